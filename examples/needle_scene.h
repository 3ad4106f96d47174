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
    int *held, held_count;
    ndl_tissue *tissue;
    ndl_needle *needle;
    double time; /* s since the start */
} scene;

/* A point of the tissue: where it is in the material, and a tet to begin looking for it. */
typedef struct scene_point {
    sb_vec3 X;
    int tet;
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

/* Reads or makes the mesh. 0, with a message, when that fails; then nothing is to be released. */
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
        if (result == SB_OK && s->mesh.element_type != SB_TET4) {
            sb_mesh_free(&s->mesh);
            return scene_complain(s, def->mesh, "needles need a volume mesh of tet4 elements");
        }
    } else {
        sb_vec3 size = sb_v3((sb_real)def->size[0], (sb_real)def->size[1], (sb_real)def->size[2]);
        result = sb_mesh_beam(SB_TET4, def->cells[0], def->cells[1], def->cells[2], size, NULL, &s->mesh, &error);
    }
    if (result != SB_OK)
        return scene_complain_of(s, &error);
    s->held = (int *)malloc(sizeof(int) * (size_t)s->mesh.node_count);
    if (!s->held) {
        sb_mesh_free(&s->mesh);
        return scene_complain(s, NULL, "memory is short");
    }
    sb_mesh_bounds(&s->mesh, &s->low, &s->high);
    return 1;
}

static inline void scene_end(scene *s)
{
    ndl_needle_destroy(s->needle);
    ndl_tissue_destroy(s->tissue);
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

/* Makes the tissue anew, at rest and without a needle. */
static inline int scene_renew(scene *s)
{
    ndl_tissue_def def = ndl_default_tissue_def();
    ndl_tissue_material material;
    sb_error error;
    ndl_needle_destroy(s->needle);
    ndl_tissue_destroy(s->tissue);
    s->needle = NULL;
    s->tissue = NULL;
    s->time = 0;
    material.young = (sb_real)s->def.young;
    material.poisson = (sb_real)s->def.poisson;
    material.density = (sb_real)s->def.density;
    def.mesh = &s->mesh;
    def.materials = &material;
    def.material_count = 1;
    def.fixed_nodes = s->held;
    def.fixed_count = s->held_count;
    def.damping_stiffness = (sb_real)s->def.damping;
    if (ndl_tissue_create(&def, &s->tissue, &error) == SB_OK)
        return 1;
    return scene_complain(s, s->def.mesh, error.message);
}

/* Makes the tissue anew and puts a needle before it; def->tissue is set here. */
static inline int scene_start(scene *s, const ndl_needle_def *def)
{
    ndl_needle_def needle = *def;
    sb_error error;
    if (!scene_renew(s))
        return 0;
    needle.tissue = s->tissue;
    if (ndl_needle_create(&needle, &s->needle, &error) == SB_OK)
        return 1;
    return scene_complain(s, "the needle", error.message);
}

/* One step of all. 0, with a message, when it fails; all is then as before it. */
static inline int scene_step(scene *s, double dt, const ndl_command *command, ndl_step_info *info)
{
    sb_error error;
    char place[64];
    sb_result result = s->needle ? ndl_step(s->tissue, &s->needle, 1, (sb_real)dt, command, info, &error)
                                 : ndl_tissue_step(s->tissue, (sb_real)dt, NULL, &error);
    s->time += dt;
    if (result == SB_OK)
        return 1;
    snprintf(place, sizeof place, "after %.3g s a step failed", s->time - dt);
    return scene_complain(s, place, error.message);
}

/* ---- points of the tissue ---- */

/* The point at X (m) of the tissue at rest; 0 when there is no tissue. */
static inline int scene_find(const scene *s, sb_vec3 X, scene_point *point)
{
    const ndl_tissue_mesh *mesh = ndl_tissue_get_mesh((ndl_tissue *)s->tissue);
    point->X = X;
    for (int t = 0; t < mesh->tet_end; t++) { /* the first walk that does not end at the surface */
        if (mesh->tets[4 * (size_t)t] < 0)
            continue;
        point->tet = ndl_tissue_mesh_find(mesh, mesh->X, X, t, NULL);
        if (point->tet >= 0)
            return 1;
        t += mesh->tet_end / 8; /* at most eight walks: the surface may stand between some and the point */
    }
    return 0;
}

/* Where a point is now (m): barycentric in the tet it is in, which changes as the mesh does. */
static inline sb_vec3 scene_where(const scene *s, scene_point *point)
{
    const ndl_tissue_mesh *mesh = ndl_tissue_get_mesh((ndl_tissue *)s->tissue);
    sb_real weights[4];
    sb_vec3 x = sb_v3(0, 0, 0);
    int tet = ndl_tissue_mesh_find(mesh, mesh->X, point->X, point->tet, weights);
    if (tet < 0 && !scene_find(s, point->X, point))
        return point->X; /* only for a point that was never in the tissue */
    if (tet < 0)
        tet = ndl_tissue_mesh_find(mesh, mesh->X, point->X, point->tet, weights);
    point->tet = tet;
    for (int c = 0; c < 4; c++)
        x = sb_v3_add(x, sb_v3_scale(weights[c], mesh->x[mesh->tets[4 * (size_t)tet + (size_t)c]]));
    return x;
}

static inline double scene_distance(sb_vec3 a, sb_vec3 b) { return (double)sb_v3_norm(sb_v3_sub(a, b)); }

/* ---- the needle ---- */

/* Where a straight line from `from` (m, outside) first meets the tissue; 0 when it does not. The tissue must be there
 * (scene_renew). */
static inline int scene_hit(const scene *s, sb_vec3 from, sb_vec3 direction, sb_vec3 *at)
{
    sb_real reach = 2 * sb_v3_norm(sb_v3_sub(s->high, s->low)) + sb_v3_norm(sb_v3_sub(from, s->low));
    ndl_surface_hit hit;
    sb_vec3 to = sb_v3_add(from, sb_v3_scale(reach / sb_v3_norm(direction), direction));
    if (!ndl_tissue_mesh_hit(ndl_tissue_get_mesh((ndl_tissue *)s->tissue), from, to, &hit))
        return 0;
    *at = sb_v3_add(from, sb_v3_scale(hit.along, sb_v3_sub(to, from)));
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

/* ---- files ---- */

/* Writes the deformed tissue with its displacements (VTK). 0, with a message, when that fails. */
static inline int scene_save(const scene *s, const char *path)
{
    const ndl_tissue_mesh *from = ndl_tissue_get_mesh((ndl_tissue *)s->tissue);
    sb_mesh mesh;
    sb_field field = {"displacement", SB_FIELD_NODES, 3, NULL};
    sb_error error;
    sb_result result = SB_ERROR_MEMORY;
    int *number = (int *)malloc(sizeof(int) * (size_t)from->node_end); /* without the slots that are not in use */
    sb_vec3 *moved = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)from->node_end);
    memset(&mesh, 0, sizeof mesh);
    mesh.element_type = SB_TET4;
    mesh.nodes = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)from->node_end);
    mesh.elements = (int *)malloc(4 * sizeof(int) * (size_t)from->tet_end);
    mesh.regions = (int *)malloc(sizeof(int) * (size_t)from->tet_end);
    memset(&error, 0, sizeof error);
    snprintf(error.message, sizeof error.message, "memory is short");
    if (number && moved && mesh.nodes && mesh.elements && mesh.regions) {
        for (int i = 0; i < from->node_end; i++) {
            number[i] = mesh.node_count;
            if (!from->node_flags[i])
                continue;
            moved[mesh.node_count] = sb_v3_sub(from->x[i], from->X[i]);
            mesh.nodes[mesh.node_count++] = from->x[i];
        }
        for (int t = 0; t < from->tet_end; t++) {
            if (from->tets[4 * (size_t)t] < 0)
                continue;
            for (int c = 0; c < 4; c++)
                mesh.elements[4 * mesh.element_count + c] = number[from->tets[4 * t + c]];
            mesh.regions[mesh.element_count++] = from->regions[t];
        }
        field.values = &moved->x;
        result = sb_mesh_save_vtk(path, &mesh, &field, 1, &error);
    }
    free(number);
    free(moved);
    free(mesh.nodes);
    free(mesh.elements);
    free(mesh.regions);
    return result == SB_OK ? 1 : scene_complain_of(s, &error);
}

/* ---- pictures ---- */

/* The tissue's faces that look away from the viewer, so that one sees into it; coloured by how far (m) they have moved,
 * up to `most`. 0 when memory is short. */
static inline int scene_draw_tissue(const scene *s, picture *p, double azimuth, double elevation, double most)
{
    static const int faces[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}}; /* outward */
    const ndl_tissue_mesh *mesh = ndl_tissue_get_mesh((ndl_tissue *)s->tissue);
    picture_vec toward = picture_make_view(azimuth, elevation, p->width, p->height).toward;
    sb_mesh surface;
    sb_real *values = (sb_real *)calloc((size_t)mesh->node_end, sizeof *values);
    int *triangles = (int *)malloc(12 * (size_t)mesh->tet_end * sizeof *triangles), count = 0;
    for (int i = 0; values && i < mesh->node_end; i++)
        if (mesh->node_flags[i])
            values[i] = sb_v3_norm(sb_v3_sub(mesh->x[i], mesh->X[i]));
    for (int k = 0; triangles && k < 4 * mesh->tet_end; k++) {
        const int *tet = mesh->tets + 4 * (k / 4);
        picture_vec corners[3];
        if (tet[0] < 0 || mesh->neighbours[k] >= 0)
            continue;
        for (int c = 0; c < 3; c++) {
            triangles[3 * count + c] = tet[faces[k % 4][c]];
            corners[c] = picture_from(mesh->x[tet[faces[k % 4][c]]]);
        }
        count += picture_dot(picture_face_normal(corners), toward) < 0;
    }
    if (values && triangles) {
        memset(&surface, 0, sizeof surface);
        surface.element_type = SB_TRI3;
        surface.nodes = mesh->x;
        surface.node_count = mesh->node_end;
        surface.elements = triangles;
        surface.element_count = count;
        picture_add_surface(p, &surface, values, 0, most);
    }
    free(values);
    free(triangles);
    return values && triangles;
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
    const ndl_tissue_mesh *mesh = ndl_tissue_get_mesh((ndl_tissue *)s->tissue);
    double most = 0;
    for (int i = 0; i < mesh->node_end; i++)
        if (mesh->node_flags[i])
            most = fmax(most, scene_distance(mesh->x[i], mesh->X[i]));
    return most;
}

#endif /* NEEDLE_SCENE_H */
