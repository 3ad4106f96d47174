/* heat_scene.h: bodies that conduct heat, and closed forms of Pennes' equation. */
#ifndef HEAT_SCENE_H
#define HEAT_SCENE_H

#include "softbody.h"

#include "scene.h"

#define HEAT_PI 3.14159265358979323846

/* Any material: what is tested is heat. */
static inline sb_body *heat_body(const sb_mesh *mesh, sb_integration integration, const sb_allocator *allocator)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = sb_material_corotated(5000, REAL(0.4), 1000);
    def.integration = integration;
    if (allocator)
        def.allocator = *allocator;
    return scene_body(&def);
}

static inline sb_heat *heat_of(sb_body *body, const sb_heat_def *def)
{
    sb_heat *heat = NULL;
    sb_error error;
    if (body && !CHECK_OK(sb_heat_create(body, def, &heat, &error)))
        printf("%s\n", error.message);
    return heat;
}

/* Holds all nodes for which `is` says so at a temperature (K); returns how many. */
static inline int heat_hold_plane(sb_heat *heat, const sb_mesh *mesh, int axis, double value, double temperature)
{
    sb_real kelvin = REAL(temperature);
    int count = 0;
    for (int i = 0; i < mesh->node_count; i++)
        if (fabs((double)scene_component(mesh->nodes[i], axis) - value) < 1e-7) {
            CHECK_OK(sb_heat_hold(heat, &i, 1, &kelvin, 1, NULL));
            count++;
        }
    return count;
}

/* Corners of the boundary faces whose nodes all lie in a plane; *corners of each. To be freed. */
static inline int *heat_faces(const sb_mesh *mesh, int axis, double value, int *count, int *corners)
{
    sb_boundary boundary;
    int *faces = NULL, width;
    *count = 0;
    if (!CHECK_OK(sb_mesh_boundary(mesh, 0, NULL, &boundary, NULL)))
        return NULL;
    width = sb_mesh_element_width(&boundary.surface);
    *corners = sb_element_corner_count(boundary.surface.element_type);
    faces = (int *)malloc((size_t)boundary.surface.element_count * (size_t)*corners * sizeof(int));
    for (int f = 0; f < boundary.surface.element_count && CHECK(faces); f++) {
        const int *nodes = boundary.surface.elements + (size_t)f * (size_t)width;
        int inside = 1;
        for (int k = 0; k < *corners; k++)
            inside &= fabs((double)scene_component(mesh->nodes[nodes[k]], axis) - value) < 1e-7;
        if (!inside)
            continue;
        memcpy(faces + (size_t)*count * (size_t)*corners, nodes, (size_t)*corners * sizeof(int));
        ++*count;
    }
    sb_boundary_free(&boundary);
    return faces;
}

/* Root mean square over the nodes of the difference from a closed form (K). */
static inline double heat_error(const sb_heat *heat, const sb_mesh *mesh, double (*form)(const void *user, sb_vec3 x),
                                const void *user)
{
    double sum = 0;
    for (int i = 0; i < mesh->node_count; i++) {
        double gap = (double)sb_heat_temperatures(heat)[i] - form(user, mesh->nodes[i]);
        sum += gap * gap / mesh->node_count;
    }
    return sqrt(sum);
}

/* A sphere of radius a held at T_w in perfused tissue: T - T_a = (T_w - T_a) (a/r) exp(-(r - a)/d). */
typedef struct heat_sphere {
    double radius, depth, blood, rise; /* m, m, K, K */
} heat_sphere;

static inline double heat_sphere_form(const void *user, sb_vec3 x)
{
    const heat_sphere *s = (const heat_sphere *)user;
    double r = (double)sb_v3_norm(x);
    return s->blood + s->rise * s->radius / r * exp(-(r - s->radius) / s->depth);
}

/* k 0.5, w 24041, a 5 mm, 43 K: d = 4.5605 mm, 7.1827 K at 10 mm. */
static inline heat_sphere heat_needle_sphere(void)
{
    heat_sphere s;
    s.radius = 0.005;
    s.depth = sqrt(0.5 / 24041);
    s.blood = 310.15;
    s.rise = 43;
    return s;
}

/* Holds the nodes where the radius is within rounding of either end at the closed form. */
static inline void heat_hold_sphere(sb_heat *heat, const sb_mesh *mesh, const heat_sphere *s, double outer)
{
    for (int i = 0; i < mesh->node_count; i++) {
        double r = (double)sb_v3_norm(mesh->nodes[i]);
        sb_real kelvin = REAL(heat_sphere_form(s, mesh->nodes[i]));
        if (fabs(r - s->radius) < 1e-7 || fabs(r - outer) < 1e-7)
            CHECK_OK(sb_heat_hold(heat, &i, 1, &kelvin, 1, NULL));
    }
}

/* Slab of thickness l, insulated elsewhere, at 0 but for both sides, which jump to 1 at t = 0: what is left to rise. */
typedef struct heat_slab {
    double length, diffusivity, time; /* m, m^2/s, s */
    double from, to;                  /* K */
} heat_slab;

static inline double heat_slab_form(const void *user, sb_vec3 x)
{
    const heat_slab *s = (const heat_slab *)user;
    double left = 0;
    for (int k = 1; k < 400; k += 2) {
        double m = k * HEAT_PI / s->length;
        left += 4 / (k * HEAT_PI) * sin(m * (double)x.x) * exp(-m * m * s->diffusivity * s->time);
    }
    return s->to + (s->from - s->to) * left;
}

#endif /* HEAT_SCENE_H */
