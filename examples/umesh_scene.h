/* umesh_scene.h: the tissue that umesh.c solves: a clamped beam, or an organ from a file, in a grid. Who is held, who
 * is seen, and what pulls. Include it after the implementation of softbody.h.
 *
 *     tissue_def def = {NULL, 32, 0};
 *     status = tissue_make(&t, &def);       0, or an exit status with a message printed
 *     status = tissue_pull(&t, seed, k);    the loads of sample k
 *     tissue_free(&t);
 */
#ifndef UMESH_SCENE_H
#define UMESH_SCENE_H

#include "network_train.h"
#include "options.h"
#include "system.h"

enum { EXIT_USAGE = 2, EXIT_SOLVE = 3, ACROSS = 8 };
static const double young = 3000, poisson = 0.45; /* Pa */

typedef struct tissue_def {
    const char *organ; /* file of its surface (m), NULL: a beam */
    int along;         /* nodes along its longest side, of a beam a multiple of 8 */
    double force;      /* N, of the strongest sample; 0: by size */
} tissue_def;

typedef struct tissue {
    sb_grid grid;
    sb_body *body;
    sb_mesh skin;               /* for pictures, and of an organ to pull at */
    sb_grid_rows rows;          /* of the skin's nodes */
    double cell, length, force; /* m, m, N */
    int is_organ;
    int counts[3];       /* nodes of the lattice, multiples of 8, */
    size_t nodes;        /* and all of them */
    size_t *place;       /* [nodes of the grid] in the lattice */
    unsigned char *mask; /* [nodes] 1 where the grid has one */
    int *seen, seen_count;
} tissue;

static inline int complain(const char *about, const char *what, int status)
{
    progress_end();
    fprintf(stderr, "umesh: %s: %s\n", about, what);
    return status;
}

static inline int no_memory(void) { return complain("memory", "is short", EXIT_SOLVE); }

static inline void tissue_free(tissue *t)
{
    sb_body_destroy(t->body);
    sb_grid_rows_free(&t->rows);
    sb_grid_free(&t->grid);
    sb_mesh_free(&t->skin);
    free(t->place), free(t->mask), free(t->seen);
}

/* ---- grids --------------------------------------------------------------------------------------------------------
 */

/* Of a box from the origin to user[3]. */
static sb_real tissue_beam_distance(void *user, sb_vec3 x)
{
    const sb_vec3 *high = (const sb_vec3 *)user;
    sb_vec3 half = sb_v3_scale((sb_real)0.5, *high), off = sb_v3_sub(x, half);
    sb_real side = sb_max(sb_abs(off.y) - half.y, sb_abs(off.z) - half.z);
    return sb_max(sb_abs(off.x) - half.x, side);
}

static inline int tissue_make_beam(tissue *t, const tissue_def *options)
{
    const double cell = 0.004, strongest = 0.02;
    sb_grid_def def = sb_default_grid_def();
    sb_boundary boundary;
    sb_error error;
    def.counts[0] = options->along - 1;
    def.counts[1] = def.counts[2] = ACROSS - 1;
    def.high = sb_v3((sb_real)(cell * def.counts[0]), (sb_real)(cell * def.counts[1]), (sb_real)(cell * def.counts[2]));
    def.outer.distance = tissue_beam_distance;
    def.outer.max_slope = 1;
    def.outer.user = &def.high;
    t->force = options->force > 0 ? options->force : strongest;
    if (sb_grid_create(&def, &t->grid, &error))
        return complain("the grid", error.message, EXIT_SOLVE);
    memset(&boundary, 0, sizeof boundary);
    if (sb_mesh_boundary(&t->grid.mesh, 1, NULL, &boundary, &error) ||
        sb_mesh_copy(&boundary.surface, NULL, &t->skin, &error)) {
        sb_boundary_free(&boundary);
        return complain("the beam", error.message, EXIT_SOLVE);
    }
    sb_boundary_free(&boundary);
    return 0;
}

static inline int tissue_make_organ(tissue *t, const tissue_def *options, sb_surface **surface)
{
    const double strongest = 0.0125; /* of Young's modulus, on a face of the cube of its volume */
    sb_grid_def def = sb_default_grid_def();
    sb_error error;
    t->is_organ = 1;
    if (sb_mesh_load(&t->skin, options->organ, NULL, &error))
        return complain(options->organ, error.message, EXIT_USAGE);
    if (t->skin.element_type != SB_TRI3)
        return complain(options->organ, "is no surface of triangles", EXIT_USAGE);
    if (sb_surface_create(&t->skin, NULL, surface, &error))
        return complain(options->organ, error.message, EXIT_USAGE);
    def.outer.surface = *surface;
    def.cells = options->along - 1;
    if (sb_grid_create(&def, &t->grid, &error))
        return complain(options->organ, error.message, EXIT_USAGE);
    t->force = options->force > 0 ? options->force : strongest * young * pow((double)t->grid.volume, 2.0 / 3);
    return 0;
}

/* The lattice around the grid, with which it shares its low corner. */
static inline int tissue_make_lattice(tissue *t)
{
    const sb_mesh *mesh = &t->grid.mesh;
    t->cell = (double)t->grid.cell_size.x;
    for (int axis = 0; axis < 3; axis++) {
        t->counts[axis] = (t->grid.counts[axis] + 8) / 8 * 8;
        t->length = fmax(t->length, t->cell * t->counts[axis]);
    }
    t->nodes = train_nodes(t->counts);
    t->place = (size_t *)malloc(t->nodes * sizeof *t->place);
    t->mask = (unsigned char *)calloc(t->nodes, 1);
    t->seen = (int *)malloc(t->nodes * sizeof *t->seen);
    if (!t->place || !t->mask || !t->seen)
        return no_memory();
    for (int i = 0; i < mesh->node_count; i++) {
        sb_vec3 x = sb_v3_scale((sb_real)(1 / t->cell), sb_v3_sub(mesh->nodes[i], t->grid.origin));
        size_t at[3] = {(size_t)((double)x.x + 0.5), (size_t)((double)x.y + 0.5), (size_t)((double)x.z + 0.5)};
        t->place[i] = (at[2] * (size_t)t->counts[1] + at[1]) * (size_t)t->counts[0] + at[0];
        t->mask[t->place[i]] = 1;
    }
    return 0;
}

/* ---- bodies -------------------------------------------------------------------------------------------------------
 */

/* What is held: the low end of a beam, and of an organ what lies farthest back and down, as its ligaments do. */
static inline int tissue_is_held(const tissue *t, sb_vec3 x)
{
    sb_vec3 low = t->grid.origin;
    double along = (double)(x.x - low.x) + (t->is_organ ? (double)(x.z - low.z) : 0), whole = 0;
    if (!t->is_organ)
        return along < t->cell / 2;
    whole = t->cell * (t->grid.counts[0] + t->grid.counts[2]);
    return along < 0.3 * whole;
}

static inline int tissue_make_body(tissue *t)
{
    sb_body_def def = sb_default_body_def();
    sb_error error;
    def.mesh = &t->grid.body_mesh;
    def.domain = &t->grid.domain;
    def.material = sb_material_stable_neo_hookean((sb_real)young, (sb_real)poisson, 1000);
    if (sb_body_create(&def, &t->body, &error))
        return complain("the body", error.message, EXIT_SOLVE);
    for (int i = 0; i < t->grid.mesh.node_count; i++)
        if (tissue_is_held(t, t->grid.mesh.nodes[i]) && sb_body_fix_nodes(t->body, &i, 1, SB_XYZ))
            return complain("the body", "cannot be held", EXIT_SOLVE);
    return 0;
}

/* Of a beam the side of largest z; of an organ the nodes of its outer cells next to skin that looks up. */
static inline int tissue_is_seen(const tissue *t, const sb_surface *surface, const int *cells, int i)
{
    sb_vec3 x = t->grid.mesh.nodes[i];
    sb_surface_hit hit;
    if (tissue_is_held(t, x))
        return 0;
    if (!t->is_organ)
        return (double)x.z > t->cell * ((double)t->grid.counts[2] - 0.5);
    return cells[i] < 8 && sb_surface_closest(surface, x, (sb_real)INFINITY, &hit) &&
           sb_surface_normal(surface, &hit).z > 0;
}

static inline int tissue_see(tissue *t, const sb_surface *surface)
{
    const sb_mesh *mesh = &t->grid.mesh;
    int *cells = (int *)calloc((size_t)mesh->node_count, sizeof *cells); /* of each node */
    if (!cells)
        return no_memory();
    for (int e = 0; e < 8 * mesh->element_count; e++)
        cells[mesh->elements[e]]++;
    for (int i = 0; i < mesh->node_count; i++)
        if (tissue_is_seen(t, surface, cells, i))
            t->seen[t->seen_count++] = i;
    free(cells);
    return t->seen_count ? 0 : complain("the body", "shows nothing", EXIT_USAGE);
}

static inline int tissue_make(tissue *t, const tissue_def *def)
{
    sb_surface *surface = NULL;
    sb_error error;
    int status;
    memset(t, 0, sizeof *t);
    status = def->organ ? tissue_make_organ(t, def, &surface) : tissue_make_beam(t, def);
    if (!status)
        status = tissue_make_lattice(t);
    if (!status)
        status = tissue_make_body(t);
    if (!status)
        status = tissue_see(t, surface);
    if (!status && sb_grid_map_points(&t->grid, t->skin.nodes, t->skin.node_count, NULL, &t->rows, &error))
        status = complain("the skin", error.message, EXIT_USAGE);
    sb_surface_destroy(surface);
    return status;
}

/* ---- loads --------------------------------------------------------------------------------------------------------
 */

/* Even in [-1, 1). */
static inline double tissue_chance(uint64_t *state) { return 2 * train_random(state) - 1; }

/* A point on one of a beam's long sides. */
static inline sb_vec3 tissue_beam_point(const tissue *t, uint64_t *state)
{
    sb_vec3 centre = sb_v3((sb_real)(t->cell * (t->counts[0] - 1) * train_random(state)), 0, 0);
    centre.y = (sb_real)(t->cell * (ACROSS - 1) * train_random(state));
    centre.z = train_random(state) < 0.5 ? 0 : (sb_real)(t->cell * (ACROSS - 1));
    if (train_random(state) < 0.5) {
        sb_real y = centre.y;
        centre.y = centre.z;
        centre.z = y;
    }
    return centre;
}

/* Spreads a force evenly over the beam's nodes within `reach` of a point. */
static inline sb_result tissue_pull_beam(const tissue *t, sb_vec3 centre, sb_real reach, sb_vec3 force, int *nodes)
{
    const sb_mesh *mesh = &t->grid.mesh;
    int count = 0;
    for (int i = 0; i < mesh->node_count; i++)
        if (sb_v3_norm(sb_v3_sub(mesh->nodes[i], centre)) < reach)
            nodes[count++] = i;
    force = sb_v3_scale(1 / (sb_real)count, force);
    return sb_body_add_forces(t->body, nodes, count, &force, 1);
}

static inline sb_vec3 tissue_triangle(const tissue *t, int e)
{
    const int *at = t->skin.elements + 3 * (size_t)e;
    sb_vec3 sum = sb_v3_add(t->skin.nodes[at[0]], sb_v3_add(t->skin.nodes[at[1]], t->skin.nodes[at[2]]));
    return sb_v3_scale((sb_real)(1.0 / 3), sum);
}

/* Spreads it evenly over the area of the organ's triangles within `reach`. Memory: nodes, each for the grid's. */
static inline sb_result tissue_pull_organ(const tissue *t, sb_vec3 centre, sb_real reach, sb_vec3 force, int *triangles,
                                          sb_vec3 *forces)
{
    int count = 0;
    sb_real area = 0;
    sb_grid_rows rows;
    sb_result result;
    memset(&rows, 0, sizeof rows);
    for (int e = 0; e < t->skin.element_count; e++)
        if (sb_v3_norm(sb_v3_sub(tissue_triangle(t, e), centre)) < reach)
            triangles[count++] = e;
    result = sb_grid_map_surface(&t->grid, &t->skin, triangles, count, NULL, &rows, NULL);
    if (result != SB_OK)
        return result;
    for (int j = 0; j < rows.rows.row_count; j++)
        area += rows.areas[j];
    force = sb_v3_scale(1 / area, force);
    sb_grid_add_traction(&rows, &force, 1, forces);
    sb_grid_rows_free(&rows);
    for (int i = 0; i < t->grid.mesh.node_count && result == SB_OK; i++)
        if (sb_v3_norm(forces[i]) > 0)
            result = sb_body_add_forces(t->body, &i, 1, forces + i, 1);
    return result;
}

/* Loads of sample k: a force of chance on the surface within 3 cells of a place of chance. */
static inline int tissue_pull(tissue *t, int seed, int k)
{
    uint64_t state = ((uint64_t)seed << 32 | (uint64_t)k) * 0x9E3779B97F4A7C15u + 1;
    sb_vec3 direction = sb_v3(0, 0, 0), centre;
    sb_real reach = (sb_real)(3 * t->cell);
    size_t room = t->nodes + (size_t)t->skin.element_count;
    int *list = (int *)malloc(room * sizeof *list);
    sb_vec3 *forces = (sb_vec3 *)calloc(t->nodes, sizeof *forces);
    sb_result result = SB_ERROR_MEMORY;
    while (sb_v3_norm(direction) < (sb_real)0.1 || sb_v3_norm(direction) > 1)
        direction =
            sb_v3((sb_real)tissue_chance(&state), (sb_real)tissue_chance(&state), (sb_real)tissue_chance(&state));
    do
        centre = t->is_organ ? tissue_triangle(t, (int)(t->skin.element_count * train_random(&state)))
                             : tissue_beam_point(t, &state);
    while (t->is_organ && tissue_is_held(t, centre)); /* where a force would do nothing */
    direction = sb_v3_scale((sb_real)(t->force * train_random(&state)) / sb_v3_norm(direction), direction);
    sb_body_clear_loads(t->body);
    if (list && forces)
        result = t->is_organ ? tissue_pull_organ(t, centre, reach, direction, list, forces)
                             : tissue_pull_beam(t, centre, reach, direction, list);
    free(list), free(forces);
    return result != SB_OK ? complain("the force", sb_result_string(result), EXIT_SOLVE) : 0;
}

/* From rest each, so that no sample depends on another. */
static inline int tissue_solve(tissue *t, int seed, int k, sb_step_info *info)
{
    int status = tissue_pull(t, seed, k);
    sb_body_reset(t->body);
    if (status)
        return status;
    return sb_body_solve_static(t->body, NULL, info) ? complain("a solve", info->error.message, EXIT_SOLVE) : 0;
}

#endif /* UMESH_SCENE_H */
