/* grid_map: points and surfaces in a grid as weights of its nodes. */
#include "grid_private.h"

/* ---- points of the body in the grid ---- */

SB_API void sb_grid_rows_free(sb_grid_rows *rows)
{
    sb_allocator allocator;
    if (!rows)
        return;
    allocator = rows->allocator;
    sbi_free(&allocator, rows->memory);
    memset(rows, 0, sizeof *rows);
}

/* Rows while they are filled. */
typedef struct sbi_grid_filling {
    const sb_grid *grid;
    int count, next;
    int *row_start, *nodes, *cells;
    sb_real *weights, *areas;
    sb_vec3 *points, *normals;
    sb_real farthest;
    void *memory;
} sbi_grid_filling;

static void sbi_grid_lay_out_rows(sbi_grid_filling *filling, int with_areas, sbi_arena *arena)
{
    size_t n = (size_t)filling->count;
    filling->row_start = (int *)sbi_arena_take(arena, n + 1, sizeof(int));
    filling->nodes = (int *)sbi_arena_take(arena, n, 8 * sizeof(int));
    filling->cells = (int *)sbi_arena_take(arena, n, sizeof(int));
    filling->weights = (sb_real *)sbi_arena_take(arena, n, 8 * sizeof(sb_real));
    filling->points = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    if (!with_areas)
        return;
    filling->areas = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    filling->normals = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
}

static sb_result sbi_grid_begin_rows(sbi_grid_filling *filling, int with_areas, const sb_allocator *allocator,
                                     sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    sbi_grid_lay_out_rows(filling, with_areas, &arena);
    filling->memory = arena.overflow ? NULL : sbi_alloc(allocator, arena.used, 1);
    if (!filling->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d rows", filling->count);
    arena.base = (unsigned char *)filling->memory;
    arena.used = 0;
    sbi_grid_lay_out_rows(filling, with_areas, &arena);
    filling->row_start[0] = 0;
    return SB_OK;
}

static void sbi_grid_end_rows(const sbi_grid_filling *filling, const sb_allocator *allocator, sb_grid_rows *rows)
{
    memset(rows, 0, sizeof *rows);
    rows->rows.row_count = filling->count;
    rows->rows.row_start = filling->row_start;
    rows->rows.nodes = filling->nodes;
    rows->rows.weights = filling->weights;
    rows->cells = filling->cells;
    rows->points = filling->points;
    rows->areas = filling->areas;
    rows->normals = filling->normals;
    rows->farthest = filling->farthest;
    rows->memory = filling->memory;
    if (allocator)
        rows->allocator = *allocator;
}

/* Distance of a coordinate from cell `index` along one axis, in cells. */
static double sbi_grid_beyond(double coordinate, int index)
{
    double below = index - coordinate, above = coordinate - index - 1;
    return below > 0 ? below : above > 0 ? above : 0;
}

/* Square of the distance (m^2) between a point, in cells from the origin, and lattice box (x, y, z). */
static double sbi_grid_gap(const sb_grid *grid, const double at[3], int x, int y, int z)
{
    double dx = (double)grid->cell_size.x * sbi_grid_beyond(at[0], x);
    double dy = (double)grid->cell_size.y * sbi_grid_beyond(at[1], y);
    double dz = (double)grid->cell_size.z * sbi_grid_beyond(at[2], z);
    return dx * dx + dy * dy + dz * dz;
}

/* First and last cell along an axis that a point may belong to, given how many cells it may be away. */
static void sbi_grid_range(double coordinate, double reach, int count, int *first, int *last)
{
    double low = floor(coordinate - reach) - 1, high = floor(coordinate + reach) + 1;
    *first = low > 0 ? (low < count ? (int)low : count) : 0;
    *last = high < count - 1 ? (high >= 0 ? (int)high : -1) : count - 1;
}

/* The lattice box of the kept cell that a point is in or nearest to, or -1: none within the longest edge of a cell.
 * *gap (m): how far away it is. */
static int sbi_grid_find_cell(const sb_grid *grid, sb_vec3 point, double *gap)
{
    const double size[3] = {(double)grid->cell_size.x, (double)grid->cell_size.y, (double)grid->cell_size.z};
    const double at[3] = {((double)point.x - (double)grid->origin.x) / size[0],
                          ((double)point.y - (double)grid->origin.y) / size[1],
                          ((double)point.z - (double)grid->origin.z) / size[2]};
    double reach = size[0] > size[1] ? size[0] : size[1], best;
    int first[3], last[3], own[3], inside = 1, found = -1;
    reach = size[2] > reach ? size[2] : reach;
    for (int i = 0; i < 3; i++) {
        sbi_grid_range(at[i], reach / size[i], grid->counts[i], &first[i], &last[i]);
        own[i] = at[i] >= 0 && at[i] < grid->counts[i] ? (int)at[i] : -1;
        inside &= own[i] >= 0;
    }
    *gap = 0;
    if (inside && grid->lattice[(own[2] * grid->counts[1] + own[1]) * grid->counts[0] + own[0]] >= 0)
        return (own[2] * grid->counts[1] + own[1]) * grid->counts[0] + own[0];
    best = reach * reach;
    for (int z = first[2]; z <= last[2]; z++)
        for (int y = first[1]; y <= last[1]; y++)
            for (int x = first[0]; x <= last[0]; x++) {
                int box = (z * grid->counts[1] + y) * grid->counts[0] + x;
                double square = grid->lattice[box] >= 0 ? sbi_grid_gap(grid, at, x, y, z) : 2 * best;
                if (square < best || (square == best && found < 0)) {
                    best = square;
                    found = box;
                }
            }
    *gap = sqrt(best);
    return found;
}

/* Appends the row of a point; `index` names it in errors. */
static sb_result sbi_grid_add_row(sbi_grid_filling *filling, sb_vec3 point, int index, const char *what,
                                  sb_error *error)
{
    const sb_grid *grid = filling->grid;
    double xi[3], shape[8], gap;
    int row = filling->next++, box = -1, cell;
    if (!sb_v3_is_finite(point))
        return sbi_fail_node(error, SB_ERROR_NOT_FINITE, index, "%s %d is not finite", what, index);
    box = sbi_grid_find_cell(grid, point, &gap);
    if (box < 0)
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, index,
                             "%s %d at (%g %g %g) is more than a cell away from every cell of the grid", what, index,
                             (double)point.x, (double)point.y, (double)point.z);
    cell = grid->lattice[box];
    sbi_grid_local(grid, sbi_grid_cell_middle(grid, box), point, xi);
    sbi_grid_shape_functions(xi, shape);
    memcpy(filling->nodes + 8 * (size_t)row, grid->mesh.elements + 8 * (size_t)cell, 8 * sizeof(int));
    for (int a = 0; a < 8; a++)
        filling->weights[8 * (size_t)row + (size_t)a] = (sb_real)shape[a];
    filling->row_start[row + 1] = 8 * (row + 1);
    filling->cells[row] = cell;
    filling->points[row] = point;
    filling->farthest = sb_max(filling->farthest, (sb_real)gap);
    return SB_OK;
}

SB_API sb_result sb_grid_map_points(const sb_grid *grid, const sb_vec3 *points, int count,
                                    const sb_allocator *allocator, sb_grid_rows *rows, sb_error *error)
{
    sbi_grid_filling filling;
    sb_result result;
    memset(&filling, 0, sizeof filling);
    if (!grid || !grid->lattice || !rows || !points || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_grid_map_points needs a grid, points and a place for the rows");
    if (count > INT32_MAX / 8 - 1)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "%d points are too many", count);
    filling.grid = grid;
    filling.count = count;
    result = sbi_grid_begin_rows(&filling, 0, allocator, error);
    for (int i = 0; i < count && result == SB_OK; i++)
        result = sbi_grid_add_row(&filling, points[i], i, "point", error);
    if (result == SB_OK)
        sbi_grid_end_rows(&filling, allocator, rows);
    else
        sbi_free(allocator, filling.memory);
    return result;
}

/* ---- surfaces in the grid ---- */

static const int *sbi_grid_triangle(const sb_mesh *surface, const int *triangles, int index)
{
    return surface->elements + 3 * (size_t)(triangles ? triangles[index] : index);
}

/* Into how many pieces along its edges a triangle is cut; 0: one point does for all of it. -1: far too many. */
static int sbi_grid_pieces(const sb_grid *grid, const sb_mesh *surface, const int *nodes)
{
    double smallest = (double)sb_min(sb_min(grid->cell_size.x, grid->cell_size.y), grid->cell_size.z), longest = 0;
    for (int i = 0; i < 3; i++) {
        sb_vec3 edge = sb_v3_sub(surface->nodes[nodes[(i + 1) % 3]], surface->nodes[nodes[i]]);
        double length = (double)sb_v3_norm(edge);
        longest = length > longest ? length : longest;
    }
    longest /= smallest;
    return longest <= 0.5 ? 0 : longest < 10000 ? (int)ceil(longest - 1e-6) : -1;
}

/* Appends a point of weight area/weight_sum at barycentric coordinates (r, s). */
static sb_result sbi_grid_add_surface_point(sbi_grid_filling *filling, const sb_vec3 corners[3], double r, double s,
                                            sb_real area, sb_vec3 normal, int triangle, sb_error *error)
{
    int row = filling->next;
    sb_vec3 point = sb_v3_madd(sb_v3_madd(corners[0], (sb_real)r, sb_v3_sub(corners[1], corners[0])), (sb_real)s,
                               sb_v3_sub(corners[2], corners[0]));
    filling->areas[row] = area;
    filling->normals[row] = normal;
    return sbi_grid_add_row(filling, point, triangle, "a point of triangle", error);
}

/* Appends the points of a triangle. Each piece, upright or upside down in the net of lines parallel to the edges, has
 * the three points of the rule of degree 2. */
static sb_result sbi_grid_add_triangle(sbi_grid_filling *filling, const sb_vec3 corners[3], int pieces, int triangle,
                                       sb_error *error)
{
    static const double rule[3][2] = {{1.0 / 6, 1.0 / 6}, {2.0 / 3, 1.0 / 6}, {1.0 / 6, 2.0 / 3}};
    sb_vec3 cross = sb_v3_cross(sb_v3_sub(corners[1], corners[0]), sb_v3_sub(corners[2], corners[0]));
    sb_real twice = sb_v3_norm(cross);
    sb_result result = SB_OK;
    if (!(twice > 0))
        return sbi_fail_element(error, SB_ERROR_MESH, triangle, "triangle %d has no area", triangle);
    cross = sb_v3_scale(1 / twice, cross);
    if (pieces == 0)
        return sbi_grid_add_surface_point(filling, corners, 1.0 / 3, 1.0 / 3, twice / 2, cross, triangle, error);
    for (int i = 0; i < pieces; i++)
        for (int j = 0; j < pieces - i; j++)
            for (int turned = 0; turned < (j < pieces - i - 1 ? 2 : 1); turned++)
                for (int p = 0; p < 3 && result == SB_OK; p++) {
                    double r = turned ? 1 - rule[p][0] : rule[p][0], s = turned ? 1 - rule[p][1] : rule[p][1];
                    sb_real area = twice / (6 * (sb_real)pieces * (sb_real)pieces);
                    result = sbi_grid_add_surface_point(filling, corners, (i + r) / pieces, (j + s) / pieces, area,
                                                        cross, triangle, error);
                }
    return result;
}

static sb_result sbi_grid_check_triangles(const sb_grid *grid, const sb_mesh *surface, const int *triangles, int count,
                                          const sb_grid_rows *rows, sb_error *error)
{
    sb_result result;
    if (!grid || !grid->lattice || !surface || !rows || (triangles && count < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "sb_grid_map_surface needs a grid, a surface and a place for the rows");
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

SB_API sb_result sb_grid_map_surface(const sb_grid *grid, const sb_mesh *surface, const int *triangles, int count,
                                     const sb_allocator *allocator, sb_grid_rows *rows, sb_error *error)
{
    sbi_grid_filling filling;
    int64_t total = 0;
    sb_result result = sbi_grid_check_triangles(grid, surface, triangles, count, rows, error);
    if (result != SB_OK)
        return result;
    memset(&filling, 0, sizeof filling);
    count = triangles ? count : surface->element_count;
    for (int i = 0; i < count; i++) {
        int pieces = sbi_grid_pieces(grid, surface, sbi_grid_triangle(surface, triangles, i));
        total += pieces ? 3 * (int64_t)pieces * pieces : 1;
        if (pieces < 0 || total > INT32_MAX / 8 - 1)
            return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the surface has too many points in cells of this size");
    }
    filling.grid = grid;
    filling.count = (int)total;
    result = sbi_grid_begin_rows(&filling, 1, allocator, error);
    for (int i = 0; i < count && result == SB_OK; i++) {
        const int *nodes = sbi_grid_triangle(surface, triangles, i);
        const sb_vec3 corners[3] = {surface->nodes[nodes[0]], surface->nodes[nodes[1]], surface->nodes[nodes[2]]};
        result = sbi_grid_add_triangle(&filling, corners, sbi_grid_pieces(grid, surface, nodes),
                                       triangles ? triangles[i] : i, error);
    }
    if (result == SB_OK)
        sbi_grid_end_rows(&filling, allocator, rows);
    else
        sbi_free(allocator, filling.memory);
    return result;
}

SB_API void sb_grid_add_traction(const sb_grid_rows *rows, const sb_vec3 *tractions, int uniform, sb_vec3 *forces)
{
    const sb_mapping *mapping = rows ? &rows->rows : NULL;
    if (!mapping || !tractions || !forces)
        return;
    for (int j = 0; j < mapping->row_count && rows->areas; j++)
        for (int k = mapping->row_start[j]; k < mapping->row_start[j + 1]; k++) {
            sb_vec3 *force = forces + mapping->nodes[k];
            *force = sb_v3_madd(*force, rows->areas[j] * mapping->weights[k], tractions[uniform ? 0 : j]);
        }
}
