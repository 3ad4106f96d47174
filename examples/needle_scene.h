/* needle_scene.h: what the needle programs share: a block of tissue or a mesh from a file, a needle above it, points
 * that move with the tissue, paths, circles through them, and a picture into the open tissue. Include it after
 * needle.h.
 *
 *     scene s;
 *     scene_def def = scene_default_def("program");
 *     if (!scene_load(&s, &def))                      (a message is printed)
 *         ...
 *     scene_hold(&s, 2, 0);                           (the lower side)
 *     scene_start(&s, &needle_def);
 *     scene_step(&s, 0.05, &command, NULL);           (as often as wanted; scene_start begins anew)
 *     scene_end(&s); */
#ifndef NEEDLE_SCENE_H
#define NEEDLE_SCENE_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "picture.h"

enum { SCENE_OK = 0, SCENE_USAGE = 2, SCENE_SOLVE = 3 }; /* exit statuses */

/* Tissue: a file, or a box. */
typedef struct scene_def {
    const char *program; /* for messages */
    const char *mesh;    /* file, or NULL: a box from the origin to `size` (m) */
    double scale;        /* of the file's lengths */
    double size[3];
    int cells[3]; /* of the box: 6 tets each */
    double young, poisson, density;
    double damping; /* stiffness-proportional (s) */
} scene_def;

typedef struct scene {
    scene_def def;
    sb_mesh mesh;
    sb_vec3 low, high; /* its box (m) */
    sb_surface *skin;  /* of the mesh at rest */
    int *held, held_count;
    sb_body *body;
    ndl_needle *needle;
    double time; /* s since the start */
} scene;

/* A point of the tissue: where it is in the material, and the cell that held it last. */
typedef struct scene_point {
    sb_vec3 X;
    int cell;
} scene_point;

/* Places that were passed one after another (m). */
typedef struct scene_path {
    sb_vec3 *points; /* [count] */
    int count, capacity;
} scene_path;

/* ---- tissue ---- */

static inline scene_def scene_default_def(const char *program)
{
    scene_def def;
    memset(&def, 0, sizeof def);
    def.program = program;
    def.scale = 1;
    def.poisson = 0.45;
    def.density = 1000;
    def.damping = 0.01;
    return def;
}

/* Prints what is wrong; returns 0. */
static inline int scene_complain(const scene *s, const char *about, const char *what)
{
    fprintf(stderr, "%s: %s%s%s\n", s->def.program, about ? about : "", about ? ": " : "", what);
    return 0;
}

/* Prints a failure of the library, with file and line where it has them; returns 0. */
static inline int scene_complain_of(const scene *s, const sb_error *error)
{
    char place[300];
    if (error->line > 0)
        snprintf(place, sizeof place, "%s:%d", error->file, error->line);
    else
        snprintf(place, sizeof place, "%s", error->file);
    return scene_complain(s, place[0] ? place : NULL, error->message);
}

/* The surface of the mesh, to aim at. */
static inline sb_result scene_make_skin(scene *s, sb_error *error)
{
    sb_boundary boundary;
    sb_result result = sb_mesh_boundary(&s->mesh, 1, NULL, &boundary, error);
    if (result != SB_OK)
        return result;
    result = sb_surface_create(&boundary.surface, NULL, &s->skin, error);
    sb_boundary_free(&boundary);
    return result;
}

/* Reads or makes the mesh and its skin. 0, with a message, when that fails; scene_end releases what is there. */
static inline int scene_load(scene *s, const scene_def *def)
{
    sb_error error;
    sb_result result;
    memset(s, 0, sizeof *s);
    s->def = *def;
    if (def->mesh) {
        sb_load_options options = sb_default_load_options();
        options.scale = (sb_real)def->scale;
        result = sb_mesh_load(&s->mesh, def->mesh, &options, &error);
        if (result == SB_OK && s->mesh.element_type != SB_TET4)
            return scene_complain(s, def->mesh, "needles need a volume mesh of tet4 elements");
    } else {
        sb_vec3 size = sb_v3((sb_real)def->size[0], (sb_real)def->size[1], (sb_real)def->size[2]);
        result = sb_mesh_beam(SB_TET4, def->cells[0], def->cells[1], def->cells[2], size, NULL, &s->mesh, &error);
    }
    if (result == SB_OK)
        result = scene_make_skin(s, &error);
    if (result != SB_OK)
        return scene_complain_of(s, &error);
    s->held = (int *)malloc(sizeof(int) * (size_t)s->mesh.node_count);
    if (!s->held)
        return scene_complain(s, NULL, "memory is short");
    sb_mesh_bounds(&s->mesh, &s->low, &s->high);
    return 1;
}

static inline void scene_end(scene *s)
{
    ndl_needle_destroy(s->needle);
    sb_body_destroy(s->body);
    sb_surface_destroy(s->skin);
    sb_mesh_free(&s->mesh);
    free(s->held);
    memset(s, 0, sizeof *s);
}

static inline double scene_axis(sb_vec3 v, int axis) { return (double)(axis == 0 ? v.x : axis == 1 ? v.y : v.z); }

static inline double scene_extent(const scene *s, int axis)
{
    return scene_axis(s->high, axis) - scene_axis(s->low, axis);
}

static inline void scene_hold_node(scene *s, int node)
{
    for (int k = 0; k < s->held_count; k++)
        if (s->held[k] == node)
            return;
    s->held[s->held_count++] = node;
}

/* Holds the side of the tissue that is lowest (upper = 0) or highest along an axis: of a mesh from a file a quarter. */
static inline void scene_hold(scene *s, int axis, int upper)
{
    double layer = (s->def.mesh ? 0.25 : 1e-6) * scene_extent(s, axis);
    for (int i = 0; i < s->mesh.node_count; i++) {
        double at = scene_axis(s->mesh.nodes[i], axis);
        if (upper ? at > scene_axis(s->high, axis) - layer : at < scene_axis(s->low, axis) + layer)
            scene_hold_node(s, i);
    }
}

/* How the tissue is stepped: one linear system a step, in which what dt cannot resolve is damped away, so that the
 * force on the needle's base does not ring. */
static inline sb_body_def scene_body_def(void)
{
    sb_body_def def = sb_default_body_def();
    def.integrator = SB_GENERALISED_ALPHA;
    def.spectral_radius = 0;
    def.max_newton = 1;
    def.tolerance = (sb_real)1e-4;
    def.slack = (sb_real)0.2; /* the mesh follows the needle */
    return def;
}

/* Makes the tissue anew, at rest and without a needle. */
static inline int scene_renew(scene *s)
{
    sb_body_def def = scene_body_def();
    sb_error error;
    sb_result result;
    ndl_needle_destroy(s->needle);
    sb_body_destroy(s->body);
    s->needle = NULL;
    s->body = NULL;
    s->time = 0;
    def.mesh = &s->mesh;
    def.material = sb_material_corotated((sb_real)s->def.young, (sb_real)s->def.poisson, (sb_real)s->def.density);
    def.damping_stiffness = (sb_real)s->def.damping;
    result = sb_body_create(&def, &s->body, &error);
    if (result == SB_OK)
        result = sb_body_hold(s->body, s->held, s->held_count, SB_XYZ, &error);
    return result == SB_OK ? 1 : scene_complain(s, s->def.mesh, error.message);
}

/* Makes the tissue anew and puts a needle before it; def->body is set here. */
static inline int scene_start(scene *s, const ndl_needle_def *def)
{
    ndl_needle_def needle = *def;
    sb_error error;
    if (!scene_renew(s))
        return 0;
    needle.body = s->body;
    if (ndl_needle_create(&needle, &s->needle, &error) == SB_OK)
        return 1;
    return scene_complain(s, "the needle", error.message);
}

/* One step of all. 0, with a message, when it fails; all is then as before it. */
static inline int scene_step(scene *s, double dt, const ndl_command *command, ndl_step_info *info)
{
    sb_step_info alone;
    sb_error error;
    char place[64];
    sb_result result;
    if (s->needle) {
        result = ndl_step(s->body, &s->needle, 1, (sb_real)dt, command, info, &error);
    } else {
        result = sb_body_step(s->body, (sb_real)dt, &alone);
        error = alone.error;
    }
    s->time += dt;
    if (result == SB_OK)
        return 1;
    snprintf(place, sizeof place, "after %.3g s a step failed", s->time - dt);
    return scene_complain(s, place, error.message);
}

/* ---- points of the tissue ---- */

/* Shares of a cell's nodes in the material point X; returns the least, negative when the point is outside. */
static inline double scene_weights(const scene *s, int cell, sb_vec3 X, double weights[4])
{
    const sb_vec3 *rest = sb_body_rest_positions(s->body);
    const int *n = sb_body_cell_nodes(s->body, cell);
    sb_vec3 edge[4], p;
    double whole, least = 1;
    for (int c = 1; c < 4; c++)
        edge[c] = sb_v3_sub(rest[n[c]], rest[n[0]]);
    p = sb_v3_sub(X, rest[n[0]]);
    whole = (double)sb_v3_dot(edge[1], sb_v3_cross(edge[2], edge[3]));
    weights[1] = (double)sb_v3_dot(p, sb_v3_cross(edge[2], edge[3])) / whole;
    weights[2] = (double)sb_v3_dot(p, sb_v3_cross(edge[3], edge[1])) / whole;
    weights[3] = (double)sb_v3_dot(p, sb_v3_cross(edge[1], edge[2])) / whole;
    weights[0] = 1 - weights[1] - weights[2] - weights[3];
    for (int c = 0; c < 4; c++)
        least = fmin(least, weights[c]);
    return least;
}

/* Looks for the point's cell: the one it was in, or the first that holds it, or that which it is least outside of.
 * weights: [4] of the cell's nodes. Returns the least of them. */
static inline double scene_locate(const scene *s, scene_point *point, double weights[4])
{
    double best = -HUGE_VAL, tried[4];
    int cells = sb_body_element_count(s->body), found = -1;
    if (point->cell >= 0 && sb_body_cell_in_use(s->body, point->cell)) {
        found = point->cell;
        best = scene_weights(s, found, point->X, weights);
    }
    for (int e = 0; e < cells && best < 0; e++) {
        double least = sb_body_cell_in_use(s->body, e) ? scene_weights(s, e, point->X, tried) : -HUGE_VAL;
        if (least > best) {
            best = least;
            found = e;
            memcpy(weights, tried, sizeof tried);
        }
    }
    point->cell = found;
    return best;
}

/* The point at X (m) of the tissue at rest; 0 when there is no tissue. */
static inline int scene_find(const scene *s, sb_vec3 X, scene_point *point)
{
    double weights[4];
    point->X = X;
    point->cell = -1;
    return scene_locate(s, point, weights) > -1e-9;
}

/* Where a point is now (m): barycentric in the cell it is in, which changes as the mesh does. */
static inline sb_vec3 scene_where(const scene *s, scene_point *point)
{
    const sb_vec3 *now = sb_body_positions(s->body);
    const int *n;
    double weights[4];
    sb_vec3 x = sb_v3(0, 0, 0);
    scene_locate(s, point, weights);
    n = sb_body_cell_nodes(s->body, point->cell);
    for (int c = 0; c < 4; c++)
        x = sb_v3_madd(x, (sb_real)weights[c], now[n[c]]);
    return x;
}

static inline double scene_distance(sb_vec3 a, sb_vec3 b) { return (double)sb_v3_norm(sb_v3_sub(a, b)); }

/* ---- the needle ---- */

/* Where a straight line from `from` (m, outside) first meets the tissue at rest; 0 when it does not. */
static inline int scene_hit(const scene *s, sb_vec3 from, sb_vec3 direction, sb_vec3 *at)
{
    sb_surface_hit hit;
    if (!sb_surface_ray(s->skin, from, direction, SB_REAL_MAX, &hit))
        return 0;
    *at = hit.point;
    return 1;
}

/* ---- steering ---- */

typedef struct scene_steering {
    ndl_steer_def def;
    scene_point target;
    double dt;                                                       /* s of a step; def.step is inserted in it */
    int (*after_step)(void *user, scene *s, const ndl_steer *steer); /* or NULL; 0 ends it all */
    void *user;
    /* results */
    ndl_steer steer; /* as it was left */
    int steps;
    double distance; /* m, from the tip to the target when all has come to rest */
} scene_steering;

static inline const char *scene_outcome(ndl_steer_status status)
{
    static const char *const names[] = {"going", "reached", "closest", "limit", "blocked"};
    return names[status];
}

/* Steers the needle to the target. 0, with a message, when a step fails. */
static inline int scene_steer(scene *s, scene_steering *g)
{
    const double rest = 0.5; /* s; what the tissue needs to come to rest */
    ndl_steer_command todo;
    ndl_command command;
    sb_error error;
    memset(&command, 0, sizeof command);
    g->steps = 0;
    if (ndl_steer_begin(&g->def, &g->steer, &error) != SB_OK)
        return scene_complain(s, "steering", error.message);
    for (;;) {
        ndl_tip_pose tip = ndl_needle_tip(s->needle);
        if (ndl_steer_update(&g->steer, &tip, scene_where(s, &g->target), &todo) != SB_OK)
            return scene_complain(s, "steering", "the tip's pose is none");
        if (todo.status != NDL_STEER_GOING)
            break;
        command.insertion = todo.insertion / (sb_real)g->dt;
        command.twist = todo.turn / (sb_real)g->dt;
        if (!scene_step(s, g->dt, &command, NULL))
            return 0;
        g->steps++;
        if (g->after_step && !g->after_step(g->user, s, &g->steer))
            return 0;
    }
    for (double t = 0; t < rest; t += g->dt)
        if (!scene_step(s, g->dt, NULL, NULL))
            return 0;
    g->distance = scene_distance(ndl_needle_tip(s->needle).position, scene_where(s, &g->target));
    return 1;
}

/* ---- paths ---- */

/* 0 when memory is short. */
static inline int scene_record(scene_path *path, sb_vec3 point)
{
    if (path->count == path->capacity) {
        int capacity = 2 * path->capacity + 256;
        sb_vec3 *grown = (sb_vec3 *)realloc(path->points, sizeof(sb_vec3) * (size_t)capacity);
        if (!grown)
            return 0;
        path->points = grown;
        path->capacity = capacity;
    }
    path->points[path->count++] = point;
    return 1;
}

/* A circle fitted to points: in the plane through `origin` along two unit vectors; `deviation` (m) is the largest
 * distance of a point from the circle, `aside` from the plane. */
typedef struct scene_circle {
    double radius, centre[2], deviation, aside;
} scene_circle;

/* Least squares of u^2 + v^2 - 2 a u - 2 b v - c (Kasa), which arcs of more than a few degrees determine well. 0 when
 * the points do not tell a circle from a line. */
static inline int scene_fit_circle(const sb_vec3 *points, int count, sb_vec3 origin, sb_vec3 along, sb_vec3 across,
                                   scene_circle *circle)
{
    double m[3][4] = {{0}}, size = 0, a, b, c;
    for (int i = 0; i < count; i++)
        size = fmax(size, scene_distance(points[i], origin));
    if (count < 3 || !(size > 0))
        return 0;
    for (int i = 0; i < count; i++) {
        sb_vec3 d = sb_v3_sub(points[i], origin);
        double row[4] = {(double)sb_v3_dot(d, along) / size, (double)sb_v3_dot(d, across) / size, 1, 0};
        row[3] = row[0] * row[0] + row[1] * row[1];
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 4; k++)
                m[j][k] += row[j] * row[k];
    }
    for (int j = 0; j < 3; j++) { /* positive definite: no pivoting */
        if (!(m[j][j] > 1e-12 * count))
            return 0;
        for (int i = 0; i < 3; i++)
            for (int k = 3; i != j && k >= j; k--)
                m[i][k] -= m[i][j] / m[j][j] * m[j][k];
    }
    a = 0.5 * m[0][3] / m[0][0];
    b = 0.5 * m[1][3] / m[1][1];
    c = m[2][3] / m[2][2];
    circle->radius = size * sqrt(c + a * a + b * b);
    circle->centre[0] = size * a;
    circle->centre[1] = size * b;
    circle->deviation = circle->aside = 0;
    for (int i = 0; i < count; i++) {
        sb_vec3 d = sb_v3_sub(points[i], origin);
        double u = (double)sb_v3_dot(d, along), v = (double)sb_v3_dot(d, across);
        double off = hypot(u - circle->centre[0], v - circle->centre[1]) - circle->radius;
        circle->deviation = fmax(circle->deviation, fabs(off));
        circle->aside = fmax(circle->aside, fabs((double)sb_v3_dot(d, sb_v3_cross(along, across))));
    }
    return 1;
}

/* ---- chance ---- */

/* Evenly spread in [0, 1), the same on every machine. */
static inline double scene_random(unsigned long long *seed)
{
    unsigned long long z = *seed += 0x9e3779b97f4a7c15ull; /* splitmix64 */
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ z >> 27) * 0x94d049bb133111ebull;
    return (double)((z ^ z >> 31) >> 11) / 9007199254740992.0;
}

static inline double scene_random_in(unsigned long long *seed, double low, double high)
{
    return low + (high - low) * scene_random(seed);
}

static inline int scene_by_size(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Sorts the values. */
static inline double scene_median(double *values, int count)
{
    qsort(values, (size_t)count, sizeof *values, scene_by_size);
    return count ? 0.5 * (values[(count - 1) / 2] + values[count / 2]) : 0;
}

/* ---- the tissue as a mesh ---- */

/* The tissue as it is now, without what is not in use. */
typedef struct scene_copy {
    sb_mesh mesh;    /* at rest */
    sb_vec3 *places; /* [mesh.node_count] where its nodes are (m) */
    sb_vec3 *moved;  /* [mesh.node_count] their displacements (m) */
} scene_copy;

static inline void scene_free_copy(scene_copy *copy)
{
    sb_mesh_free(&copy->mesh);
    free(copy->places);
    free(copy->moved);
    memset(copy, 0, sizeof *copy);
}

/* 0, with a message, when memory is short; then nothing is to be released. */
static inline int scene_make_copy(const scene *s, scene_copy *copy)
{
    size_t slots = (size_t)sb_body_node_count(s->body);
    int *number = (int *)malloc(sizeof(int) * slots);
    memset(copy, 0, sizeof *copy);
    copy->places = (sb_vec3 *)malloc(sizeof(sb_vec3) * slots);
    copy->moved = (sb_vec3 *)malloc(sizeof(sb_vec3) * slots);
    if (!number || !copy->places || !copy->moved ||
        sb_body_get_mesh(s->body, NULL, &copy->mesh, number, NULL, NULL) != SB_OK) {
        free(number);
        scene_free_copy(copy);
        return scene_complain(s, NULL, "memory is short");
    }
    for (size_t i = 0; i < slots; i++)
        if (number[i] >= 0) {
            copy->places[number[i]] = sb_body_positions(s->body)[i];
            copy->moved[number[i]] = sb_body_displacements(s->body)[i];
        }
    free(number);
    return 1;
}

/* Writes the deformed tissue with its displacements (VTK). 0, with a message, when that fails. */
static inline int scene_save(const scene *s, const char *path)
{
    scene_copy copy;
    sb_mesh deformed;
    sb_field field = {"displacement", SB_FIELD_NODES, 3, NULL};
    sb_error error;
    sb_result result;
    if (!scene_make_copy(s, &copy))
        return 0;
    deformed = copy.mesh;
    deformed.nodes = copy.places;
    field.values = &copy.moved->x;
    result = sb_mesh_save_vtk(path, &deformed, &field, 1, &error);
    scene_free_copy(&copy);
    return result == SB_OK ? 1 : scene_complain_of(s, &error);
}

/* ---- pictures ---- */

/* Of a closed surface the faces that look away from the viewer, so that one sees into it; `values` as of
 * picture_add_surface. 0 when memory is short. */
static inline int scene_draw_open(const sb_mesh *closed, picture *p, double azimuth, double elevation,
                                  const sb_real *values, double most)
{
    picture_vec toward = picture_make_view(azimuth, elevation, p->width, p->height).toward;
    sb_mesh open = *closed;
    open.elements = (int *)malloc(sizeof(int) * 3 * (size_t)closed->element_count);
    open.element_count = 0;
    open.regions = NULL;
    if (!open.elements)
        return 0;
    for (int e = 0; e < closed->element_count; e++) {
        const int *n = closed->elements + 3 * (size_t)e;
        picture_vec corners[3];
        for (int c = 0; c < 3; c++)
            corners[c] = picture_from(closed->nodes[n[c]]);
        if (picture_dot(picture_face_normal(corners), toward) < 0)
            memcpy(open.elements + 3 * (size_t)open.element_count++, n, 3 * sizeof *n);
    }
    picture_add_surface(p, &open, values, 0, most);
    free(open.elements);
    return 1;
}

/* The tissue, open towards the viewer; coloured by how far (m) it has moved, up to `most`. 0 when memory is short. */
static inline int scene_draw_tissue(const scene *s, picture *p, double azimuth, double elevation, double most)
{
    scene_copy copy;
    sb_boundary boundary;
    sb_real *values;
    int drawn = 0;
    if (!scene_make_copy(s, &copy))
        return 0;
    if (sb_mesh_boundary(&copy.mesh, 1, NULL, &boundary, NULL) == SB_OK) {
        values = (sb_real *)malloc(sizeof(sb_real) * (size_t)boundary.surface.node_count);
        for (int i = 0; values && i < boundary.surface.node_count; i++) {
            boundary.surface.nodes[i] = copy.places[boundary.nodes[i]];
            values[i] = sb_v3_norm(copy.moved[boundary.nodes[i]]);
        }
        drawn = values && scene_draw_open(&boundary.surface, p, azimuth, elevation, values, most);
        free(values);
        sb_boundary_free(&boundary);
    }
    scene_free_copy(&copy);
    return drawn;
}

/* The needle from its sleeve to its tip, `radius` (m) thick. */
static inline void scene_draw_needle(const scene *s, picture *p, double radius)
{
    const ndl_rod *rod = ndl_needle_rod(s->needle);
    const sb_vec3 *x = ndl_rod_positions(rod);
    int nodes = ndl_rod_node_count(rod);
    for (int i = 0; i + 1 < nodes; i++)
        picture_add_capsule(p, x[i], x[i + 1], radius, picture_web(i == 0 ? 0x3d4854 : 0x9aa5b1));
}

static inline void scene_draw_path(picture *p, const scene_path *path, double radius, unsigned colour)
{
    for (int i = 0; i + 1 < path->count; i++)
        picture_add_capsule(p, path->points[i], path->points[i + 1], radius, picture_web(colour));
}

/* Largest distance (m) that a node of the tissue has moved. */
static inline double scene_most_motion(const scene *s)
{
    const sb_vec3 *moved = sb_body_displacements(s->body); /* 0 where there is no node */
    double most = 0;
    for (int i = 0; i < sb_body_node_count(s->body); i++)
        most = fmax(most, (double)sb_v3_norm(moved[i]));
    return most;
}

#endif /* NEEDLE_SCENE_H */
