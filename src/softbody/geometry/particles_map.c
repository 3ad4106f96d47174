/* particles_map: points and surfaces among particles as weights of them. */
#include "particles_private.h"

/* Rows while they are filled. */
typedef struct sbi_particle_rows {
    const sb_particles *particles;
    const sbi_near *near;
    int count, next;
    int *row_start, *nodes, *cells;
    sb_real *weights, *areas;
    sb_vec3 *points, *normals;
    double farthest;
    void *memory;
} sbi_particle_rows;

static void sbi_particle_lay_out_rows(sbi_particle_rows *rows, int with_areas, sbi_arena *arena)
{
    size_t n = (size_t)rows->count;
    rows->row_start = (int *)sbi_arena_take(arena, n + 1, sizeof(int));
    rows->nodes = (int *)sbi_arena_take(arena, n, SBI_PARTICLE_NODES * sizeof(int));
    rows->cells = (int *)sbi_arena_take(arena, n, sizeof(int));
    rows->weights = (sb_real *)sbi_arena_take(arena, n, SBI_PARTICLE_NODES * sizeof(sb_real));
    rows->points = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    if (!with_areas)
        return;
    rows->areas = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    rows->normals = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
}

static sb_result sbi_particle_begin_rows(sbi_particle_rows *rows, int with_areas, const sb_allocator *allocator,
                                         sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    sbi_particle_lay_out_rows(rows, with_areas, &arena);
    rows->memory =
        arena.overflow || rows->count > INT32_MAX / SBI_PARTICLE_NODES ? NULL : sbi_alloc(allocator, arena.used, 1);
    if (!rows->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d rows", rows->count);
    arena.base = (unsigned char *)rows->memory;
    arena.used = 0;
    sbi_particle_lay_out_rows(rows, with_areas, &arena);
    rows->row_start[0] = 0;
    return SB_OK;
}

static void sbi_particle_end_rows(const sbi_particle_rows *from, const sb_allocator *allocator, sb_grid_rows *rows)
{
    memset(rows, 0, sizeof *rows);
    rows->rows.row_count = from->count;
    rows->rows.row_start = from->row_start;
    rows->rows.nodes = from->nodes;
    rows->rows.weights = from->weights;
    rows->cells = from->cells;
    rows->points = from->points;
    rows->areas = from->areas;
    rows->normals = from->normals;
    rows->farthest = (sb_real)from->farthest;
    rows->memory = from->memory;
    if (allocator)
        rows->allocator = *allocator;
}

/* Appends the row of a point; `index` names it in errors. */
static sb_result sbi_particle_add_row(sbi_particle_rows *rows, sb_vec3 point, int index, const char *what,
                                      sb_error *error)
{
    const sb_particles *particles = rows->particles;
    sb_particles_def def = particles->def;
    int row = rows->next, start = rows->row_start[row], good = 0;
    double shapes[SBI_PARTICLE_NODES], rank, h = 0;
    sbi_neighbours near;
    def.basis = def.method == SB_PARTICLES_GRID ? def.basis : 4;
    def.method = SB_PARTICLES_GRID;
    def.neighbours = sbi_max_int(def.neighbours, 2 * def.basis);
    if (!sb_v3_is_finite(point))
        return sbi_fail_node(error, SB_ERROR_NOT_FINITE, index, "%s %d is not finite", what, index);
    if (!sbi_near_find(rows->near, point, -1, 1, 1, 0, &near) || near.count == 0 ||
        near.distance[0] > 2 * (double)particles->spacing)
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, index, "%s %d is farther than two spacings from any particle",
                             what, index);
    rows->cells[row] = near.nodes[0];
    rows->farthest = fmax(rows->farthest, near.distance[0]);
    for (int growth = 0; growth < 4 && !good; growth++)
        good = sbi_near_gather(rows->near, &def, point, -1, growth, &near, &h) && near.count > 0 &&
               sbi_moving_shapes(def.kernel, def.basis, h, &near, 0, shapes, NULL, &rank);
    if (!good)
        return sbi_fail_node(error, SB_ERROR_MESH, index, "the neighbours of %s %d do not span space, or are too many",
                             what, index);
    for (int j = 0; j < near.count; j++) {
        rows->nodes[start + j] = near.nodes[j];
        rows->weights[start + j] = (sb_real)shapes[j];
    }
    rows->points[row] = point;
    rows->row_start[++rows->next] = start + near.count;
    return SB_OK;
}

static sb_result sbi_particle_near(const sb_particles *particles, sbi_near *near, sb_error *error)
{
    sb_result result = sbi_near_create(particles->mesh.nodes, particles->mesh.node_count, particles->spacing,
                                       &particles->def.allocator, near, error);
    near->cuts = particles->cuts;
    near->cut_count = particles->cut_count;
    return result;
}

SB_API sb_result sb_particles_map_points(const sb_particles *particles, const sb_vec3 *points, int count,
                                         const sb_allocator *allocator, sb_grid_rows *rows, sb_error *error)
{
    sbi_particle_rows filling;
    sbi_near near;
    sb_result result;
    if (!particles || !particles->table || !points || count < 1 || !rows)
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "sb_particles_map_points needs particles, points and a place for the rows");
    result = sbi_particle_near(particles, &near, error);
    if (result != SB_OK)
        return result;
    memset(&filling, 0, sizeof filling);
    filling.particles = particles;
    filling.near = &near;
    filling.count = count;
    result = sbi_particle_begin_rows(&filling, 0, allocator, error);
    for (int i = 0; i < count && result == SB_OK; i++)
        result = sbi_particle_add_row(&filling, points[i], i, "point", error);
    if (result == SB_OK)
        sbi_particle_end_rows(&filling, allocator, rows);
    else
        sbi_free(allocator, filling.memory);
    sbi_near_free(&near, &particles->def.allocator);
    return result;
}

/* ---- surfaces ---- */

static const int *sbi_particle_triangle(const sb_mesh *surface, const int *triangles, int i)
{
    return surface->elements + 3 * (size_t)(triangles ? triangles[i] : i);
}

/* Pieces along each side of a triangle so that none is longer than a spacing. */
static double sbi_particle_pieces(const sb_particles *particles, const sb_mesh *surface, const int *nodes)
{
    double longest = 0, pieces;
    for (int i = 0; i < 3; i++) {
        sb_vec3 side = sb_v3_sub(surface->nodes[nodes[(i + 1) % 3]], surface->nodes[nodes[i]]);
        longest = fmax(longest, (double)sb_v3_norm(side));
    }
    pieces = ceil(longest / (double)particles->spacing * (1 - 1e-9));
    return pieces < 1 ? 1 : pieces;
}

/* Rows at the middles of the pieces of a triangle. */
static sb_result sbi_particle_add_triangle(sbi_particle_rows *rows, const sb_mesh *surface, const int *nodes,
                                           int triangle, sb_error *error)
{
    sb_vec3 corner = surface->nodes[nodes[0]], a = sb_v3_sub(surface->nodes[nodes[1]], corner),
            b = sb_v3_sub(surface->nodes[nodes[2]], corner), cross = sb_v3_cross(a, b);
    sb_real twice = sb_v3_norm(cross);
    int pieces = (int)sbi_particle_pieces(rows->particles, surface, nodes);
    sb_result result = SB_OK;
    if (!(twice > 0))
        return sbi_fail_element(error, SB_ERROR_MESH, triangle, "triangle %d has no area", triangle);
    for (int i = 0; i < pieces; i++)
        for (int j = 0; j < pieces - i; j++)
            for (int turned = 0; turned < (j < pieces - i - 1 ? 2 : 1) && result == SB_OK; turned++) {
                double r = (i + (turned ? 2.0 : 1.0) / 3) / pieces, s = (j + (turned ? 2.0 : 1.0) / 3) / pieces;
                int row = rows->next;
                sb_vec3 point = sb_v3_madd(sb_v3_madd(corner, (sb_real)r, a), (sb_real)s, b);
                rows->areas[row] = twice / (2 * (sb_real)pieces * (sb_real)pieces);
                rows->normals[row] = sb_v3_scale(1 / twice, cross);
                result = sbi_particle_add_row(rows, point, triangle, "a point of triangle", error);
            }
    return result;
}

static sb_result sbi_particle_check_surface(const sb_particles *particles, const sb_mesh *surface, const int *triangles,
                                            int count, const sb_grid_rows *rows, sb_error *error)
{
    sb_result result;
    if (!particles || !particles->table || !surface || !rows || (triangles && count < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "sb_particles_map_surface needs particles, a surface and a place for the rows");
    result = sbi_mesh_check_arrays(surface, error);
    if (result != SB_OK)
        return result;
    if (surface->element_type != SB_TRI3)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a surface of tri3 is needed, not of %s",
                        sb_element_name(surface->element_type));
    for (int i = 0; triangles && i < count; i++)
        if (triangles[i] < 0 || triangles[i] >= surface->element_count)
            return sbi_fail_element(error, SB_ERROR_INDEX, triangles[i], "the surface has no triangle %d",
                                    triangles[i]);
    return SB_OK;
}

SB_API sb_result sb_particles_map_surface(const sb_particles *particles, const sb_mesh *surface, const int *triangles,
                                          int count, const sb_allocator *allocator, sb_grid_rows *rows, sb_error *error)
{
    sbi_particle_rows filling;
    sbi_near near;
    double total = 0;
    sb_result result = sbi_particle_check_surface(particles, surface, triangles, count, rows, error);
    if (result != SB_OK)
        return result;
    count = triangles ? count : surface->element_count;
    for (int i = 0; i < count; i++) {
        double pieces = sbi_particle_pieces(particles, surface, sbi_particle_triangle(surface, triangles, i));
        total += pieces * pieces;
    }
    if (!(total < INT32_MAX / SBI_PARTICLE_NODES))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the surface has too many points at this spacing");
    result = sbi_particle_near(particles, &near, error);
    if (result != SB_OK)
        return result;
    memset(&filling, 0, sizeof filling);
    filling.particles = particles;
    filling.near = &near;
    filling.count = (int)total;
    result = sbi_particle_begin_rows(&filling, 1, allocator, error);
    for (int i = 0; i < count && result == SB_OK; i++)
        result = sbi_particle_add_triangle(&filling, surface, sbi_particle_triangle(surface, triangles, i),
                                           triangles ? triangles[i] : i, error);
    if (result == SB_OK)
        sbi_particle_end_rows(&filling, allocator, rows);
    else
        sbi_free(allocator, filling.memory);
    sbi_near_free(&near, &particles->def.allocator);
    return result;
}
