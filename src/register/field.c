/* field: distances to surfaces and clouds, and Laplace's potential on a grid. */
#include "field.h"

#include <string.h>

#include "kdtree.h"

#define REGI_FIELD_COOKIE 0x66696c64u

enum { REGI_FIELD_NEIGHBOURS = 12 }; /* points of a cloud that decide whether one of them is on its rim */

/* Laplace's potential at the corners of a grid of cubes. */
typedef struct regi_field_grid {
    sb_vec3 low;
    sb_real cell; /* m */
    int count[3]; /* corners along each axis */
    sb_real *phi; /* [corners] m, x fastest */
    int sweeps;
} regi_field_grid;

struct reg_field {
    sb_allocator allocator;
    reg_field_kind kind;
    sb_vec3 low, high;
    sb_surface *surface;
    reg_kdtree *tree; /* of a cloud; NULL for a surface */
    int point_count;
    sb_vec3 *points;       /* of the cloud */
    sb_vec3 *normals;      /* of the cloud, unit or 0; NULL: none */
    unsigned char *border; /* triangles: bit i for edge i, bit 3 + i for corner i; points: 1 */
    regi_field_grid grid;
};

REG_API reg_field_def reg_default_field_def(void)
{
    reg_field_def def;
    memset(&def, 0, sizeof def);
    def.kind = REG_FIELD_DISTANCE;
    def.cells = 64;
    def.cookie = REGI_FIELD_COOKIE;
    return def;
}

REG_API void reg_field_destroy(reg_field *field)
{
    sb_allocator allocator;
    if (!field)
        return;
    allocator = field->allocator;
    sb_surface_destroy(field->surface);
    reg_kdtree_destroy(field->tree);
    sbi_free(&allocator, field->points);
    sbi_free(&allocator, field->normals);
    sbi_free(&allocator, field->border);
    sbi_free(&allocator, field->grid.phi);
    sbi_free(&allocator, field);
}

/* ---- checks ---- */

static sb_result regi_field_check_points(const reg_field_def *def, sb_error *error)
{
    if (def->point_count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a cloud of %d points is no target", def->point_count);
    for (int i = 0; i < def->point_count; i++) {
        if (!sb_v3_is_finite(def->points[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "point %d of the target is not finite", i);
        if (def->normals && !sb_v3_is_finite(def->normals[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "normal %d of the target is not finite", i);
    }
    return SB_OK;
}

static sb_result regi_field_check(const reg_field_def *def, sb_error *error)
{
    if (!def || def->cookie != REGI_FIELD_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a field needs a def made by reg_default_field_def");
    if (def->kind != REG_FIELD_DISTANCE && def->kind != REG_FIELD_LAPLACE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "there is no field of kind %d", (int)def->kind);
    if ((def->surface != NULL) == (def->points != NULL))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a field needs either a surface or points");
    if (def->cells < 8 || def->cells > 256)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "cells is %d, not in [8, 256]", def->cells);
    if (!sb_v3_is_finite(def->low) || !sb_v3_is_finite(def->high))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "a corner of the field's box is not finite");
    if (def->high.x < def->low.x || def->high.y < def->low.y || def->high.z < def->low.z)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the box of the field has high below low");
    return def->points ? regi_field_check_points(def, error) : SB_OK;
}

/* ---- a surface and its rim ---- */

/* Bits of the edges that no other triangle shares, then of all corners at such edges. rim: scratch [nodes], zeroed. */
static void regi_field_mark_border(const sb_mesh *mesh, const sb_index_table *neighbours, unsigned char *rim,
                                   unsigned char *border)
{
    for (int t = 0; t < mesh->element_count; t++) {
        border[t] = 0;
        for (int i = 0; i < 3; i++)
            if (neighbours->items[3 * t + i] < 0) {
                border[t] = (unsigned char)(border[t] | 1 << i);
                rim[mesh->elements[3 * t + i]] = rim[mesh->elements[3 * t + (i + 1) % 3]] = 1;
            }
    }
    for (int t = 0; t < mesh->element_count; t++)
        for (int i = 0; i < 3; i++)
            if (rim[mesh->elements[3 * t + i]])
                border[t] = (unsigned char)(border[t] | 8 << i);
}

static sb_result regi_field_find_border(reg_field *field, const sb_mesh *mesh, sb_error *error)
{
    sb_index_table neighbours;
    unsigned char *rim;
    sb_result result = sb_mesh_neighbours(mesh, &field->allocator, &neighbours, error);
    if (result != SB_OK)
        return result;
    rim = (unsigned char *)sbi_alloc_zeroed(&field->allocator, (size_t)mesh->node_count, 1);
    field->border = (unsigned char *)sbi_alloc(&field->allocator, (size_t)mesh->element_count, 1);
    if (rim && field->border)
        regi_field_mark_border(mesh, &neighbours, rim, field->border);
    else
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the rim of %d triangles", mesh->element_count);
    sbi_free(&field->allocator, rim);
    sb_index_table_free(&neighbours);
    return result;
}

static sb_result regi_field_make_surface(reg_field *field, const sb_mesh *surface, sb_error *error)
{
    sb_mesh triangles;
    sb_result result = sb_surface_triangulate(surface, &field->allocator, &triangles, error);
    if (result != SB_OK)
        return result;
    result = sb_surface_create(&triangles, &field->allocator, &field->surface, error);
    if (result == SB_OK)
        result = regi_field_find_border(field, &triangles, error);
    if (result == SB_OK)
        sb_surface_bounds(field->surface, &field->low, &field->high);
    sb_mesh_free(&triangles);
    return result;
}

/* ---- a cloud and its rim ---- */

/* On a rim the neighbours lie to one side: the centre of a half disc is 0.42 radii from the middle of its straight
 * edge. */
static int regi_field_is_rim(const reg_field *field, int point)
{
    int near[REGI_FIELD_NEIGHBOURS];
    sb_real squares[REGI_FIELD_NEIGHBOURS];
    sb_vec3 centre = sb_v3(0, 0, 0), at = field->points[point];
    int count = reg_kdtree_k_nearest(field->tree, at, REGI_FIELD_NEIGHBOURS, near, squares);
    if (count < REGI_FIELD_NEIGHBOURS)
        return 0;
    for (int i = 0; i < count; i++)
        centre = sb_v3_madd(centre, (sb_real)1 / (sb_real)count, sb_v3_sub(field->points[near[i]], at));
    return sb_v3_dot(centre, centre) > (sb_real)(0.3 * 0.3) * squares[count - 1];
}

enum { REGI_FIELD_CHUNK = 1024 };

static void regi_field_find_rims(void *user, int chunk)
{
    reg_field *field = (reg_field *)user;
    int first = chunk * REGI_FIELD_CHUNK, last = first + sbi_min_int(REGI_FIELD_CHUNK, field->point_count - first);
    for (int i = first; i < last; i++)
        field->border[i] = (unsigned char)regi_field_is_rim(field, i);
}

static sb_result regi_field_make_cloud(reg_field *field, const reg_field_def *def, sb_error *error)
{
    size_t count = (size_t)def->point_count;
    sb_result result = reg_kdtree_create(def->points, def->point_count, &field->allocator, &field->tree, error);
    if (result != SB_OK)
        return result;
    field->point_count = def->point_count;
    field->points = (sb_vec3 *)sbi_alloc(&field->allocator, count, sizeof(sb_vec3));
    field->border = (unsigned char *)sbi_alloc(&field->allocator, count, 1);
    if (def->normals)
        field->normals = (sb_vec3 *)sbi_alloc(&field->allocator, count, sizeof(sb_vec3));
    if (!field->points || !field->border || (def->normals && !field->normals))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a target of %d points", def->point_count);
    memcpy(field->points, def->points, count * sizeof(sb_vec3));
    field->low = field->high = def->points[0];
    for (int i = 0; i < def->point_count; i++) {
        sb_vec3 p = def->points[i], n = def->normals ? def->normals[i] : p;
        sb_real length = sb_v3_norm(n);
        field->low = sb_v3(sb_min(field->low.x, p.x), sb_min(field->low.y, p.y), sb_min(field->low.z, p.z));
        field->high = sb_v3(sb_max(field->high.x, p.x), sb_max(field->high.y, p.y), sb_max(field->high.z, p.z));
        if (def->normals)
            field->normals[i] = length > 0 ? sb_v3_scale((sb_real)1 / length, n) : sb_v3(0, 0, 0);
    }
    sbi_run(&def->jobs, regi_field_find_rims, field, (def->point_count - 1) / REGI_FIELD_CHUNK + 1);
    return SB_OK;
}

/* ---- closest places ---- */

static int regi_field_closest_triangle(const reg_field *field, sb_vec3 point, int guess, reg_field_hit *hit)
{
    sb_surface_hit found;
    unsigned rim;
    if (!sb_surface_closest_from(field->surface, point, SB_REAL_MAX, guess, &found))
        return 0;
    rim = field->border[found.triangle];
    hit->point = found.point;
    hit->normal = sb_surface_normal(field->surface, &found);
    hit->distance = found.distance;
    hit->item = found.triangle;
    hit->on_border = (found.feature == SB_SURFACE_EDGE && (rim >> found.index & 1)) ||
                     (found.feature == SB_SURFACE_VERTEX && (rim >> (3 + found.index) & 1));
    return 1;
}

static int regi_field_closest_point(const reg_field *field, sb_vec3 point, reg_field_hit *hit)
{
    sb_real square = 0;
    int nearest = sb_v3_is_finite(point) ? reg_kdtree_nearest(field->tree, point, SB_REAL_MAX, &square) : -1;
    if (nearest < 0 || !sb_is_finite(square))
        return 0;
    hit->point = field->points[nearest];
    hit->normal = field->normals ? field->normals[nearest] : sb_v3(0, 0, 0);
    hit->distance = sb_sqrt(square);
    hit->item = nearest;
    hit->on_border = field->border[nearest];
    return 1;
}

REG_API int reg_field_closest(const reg_field *field, sb_vec3 point, int guess, reg_field_hit *hit)
{
    if (!field || !hit)
        return 0;
    return field->tree ? regi_field_closest_point(field, point, hit)
                       : regi_field_closest_triangle(field, point, guess, hit);
}

/* ---- the grid ---- */

/* Cell and place within it, in [0, 1], along one axis. */
static int regi_field_locate(sb_real x, sb_real low, sb_real cell, int corners, sb_real *share)
{
    sb_real place = (x - low) / cell, last = (sb_real)(corners - 1);
    int index;
    place = sb_max(0, sb_min(place, last));
    index = sbi_min_int((int)place, corners - 2);
    *share = place - (sb_real)index;
    return index;
}

/* Trilinear interpolation and its gradient. */
static sb_real regi_field_interpolate(const regi_field_grid *grid, sb_vec3 point, sb_vec3 *gradient)
{
    sb_real s[3], phi = 0, slope[3] = {0, 0, 0};
    int i = regi_field_locate(point.x, grid->low.x, grid->cell, grid->count[0], &s[0]);
    int j = regi_field_locate(point.y, grid->low.y, grid->cell, grid->count[1], &s[1]);
    int k = regi_field_locate(point.z, grid->low.z, grid->cell, grid->count[2], &s[2]);
    size_t row = (size_t)grid->count[0], plane = row * (size_t)grid->count[1];
    const sb_real *at = grid->phi + (size_t)i + (size_t)j * row + (size_t)k * plane;
    for (int corner = 0; corner < 8; corner++) {
        int bit[3] = {corner & 1, corner >> 1 & 1, corner >> 2};
        sb_real value = at[(size_t)bit[0] + (size_t)bit[1] * row + (size_t)bit[2] * plane], w[3];
        for (int a = 0; a < 3; a++)
            w[a] = bit[a] ? s[a] : 1 - s[a];
        phi += w[0] * w[1] * w[2] * value;
        for (int a = 0; a < 3; a++)
            slope[a] += (bit[a] ? value : -value) * w[(a + 1) % 3] * w[(a + 2) % 3];
    }
    *gradient = sb_v3_scale((sb_real)1 / grid->cell, sb_v3(slope[0], slope[1], slope[2]));
    return phi;
}

static sb_vec3 regi_field_corner(const regi_field_grid *grid, int i, int j, int k)
{
    return sb_v3_madd(grid->low, grid->cell, sb_v3((sb_real)i, (sb_real)j, (sb_real)k));
}

/* What setting up the grid's rows of corners needs; each (j, k) is one task. */
typedef struct regi_field_filling {
    const reg_field *field;
    unsigned char *held; /* [corners] 1: the value is given */
} regi_field_filling;

/* Corners next to the target have their distance to it, which is what its zero means for them; those on the box
 * have theirs too; all others start there. */
static void regi_field_fill_row(void *user, int row)
{
    const regi_field_filling *filling = (const regi_field_filling *)user;
    const regi_field_grid *grid = &filling->field->grid;
    int j = row % grid->count[1], k = row / grid->count[1], guess = -1;
    int outer = j == 0 || k == 0 || j == grid->count[1] - 1 || k == grid->count[2] - 1;
    for (int i = 0; i < grid->count[0]; i++) {
        size_t at = (size_t)row * (size_t)grid->count[0] + (size_t)i;
        reg_field_hit hit;
        hit.distance = 0;
        if (reg_field_closest(filling->field, regi_field_corner(grid, i, j, k), guess, &hit))
            guess = hit.item;
        grid->phi[at] = hit.distance;
        filling->held[at] = outer || i == 0 || i == grid->count[0] - 1 || hit.distance < (sb_real)0.87 * grid->cell;
    }
}

/* One half sweep of successive over-relaxation over the corners of one colour of a chessboard. Returns the largest
 * change. */
static sb_real regi_field_relax(regi_field_grid *grid, const unsigned char *held, int colour, sb_real omega)
{
    size_t row = (size_t)grid->count[0], plane = row * (size_t)grid->count[1];
    sb_real most = 0;
    for (int k = 1; k < grid->count[2] - 1; k++)
        for (int j = 1; j < grid->count[1] - 1; j++) {
            sb_real *phi = grid->phi + (size_t)k * plane + (size_t)j * row;
            const unsigned char *given = held + (size_t)k * plane + (size_t)j * row;
            for (int i = 1 + (j + k + colour) % 2; i < grid->count[0] - 1; i += 2) {
                sb_real *p = phi + i;
                sb_real mean = (p[-1] + p[1] + *(p - row) + *(p + row) + *(p - plane) + *(p + plane)) / 6;
                sb_real change = given[i] ? 0 : omega * (mean - *p);
                *p += change;
                most = sb_max(most, sb_abs(change));
            }
        }
    return most;
}

/* The factor that is best for a cube of as many cells. */
static sb_real regi_field_omega(const regi_field_grid *grid)
{
    sb_real s, c;
    int longest = sbi_max_int(grid->count[0], sbi_max_int(grid->count[1], grid->count[2]));
    sb_sin_cos((sb_real)3.14159265358979 / (sb_real)longest, &s, &c);
    return 2 / (1 + s);
}

/* Until no corner changes by more than 1e-4 cells in a sweep, which is far below what the grid resolves. */
static void regi_field_solve(regi_field_grid *grid, const unsigned char *held)
{
    sb_real omega = regi_field_omega(grid), enough = (sb_real)1e-4 * grid->cell, change = enough + 1;
    for (grid->sweeps = 0; grid->sweeps < 2000 && change > enough; grid->sweeps++) {
        change = regi_field_relax(grid, held, 0, omega);
        change = sb_max(change, regi_field_relax(grid, held, 1, omega));
    }
}

/* The box of the def, enlarged, and the number of corners; 0 when it is too large for numbers. */
static int regi_field_plan(reg_field *field, const reg_field_def *def)
{
    regi_field_grid *grid = &field->grid;
    sb_real margin = (sb_real)0.1 * sb_v3_norm(sb_v3_sub(field->high, field->low)), longest;
    sb_vec3 edge, low = sb_v3_sub(field->low, sb_v3(margin, margin, margin));
    sb_vec3 high = sb_v3_add(field->high, sb_v3(margin, margin, margin)), size = sb_v3_sub(def->high, def->low);
    if (size.x > 0 || size.y > 0 || size.z > 0) {
        low = sb_v3(sb_min(low.x, def->low.x), sb_min(low.y, def->low.y), sb_min(low.z, def->low.z));
        high = sb_v3(sb_max(high.x, def->high.x), sb_max(high.y, def->high.y), sb_max(high.z, def->high.z));
    }
    edge = sb_v3_sub(high, low);
    longest = sb_max(edge.x, sb_max(edge.y, edge.z));
    if (!sb_is_finite(longest) || !sb_v3_is_finite(edge))
        return 0;
    grid->low = low;
    grid->cell = longest > 0 ? longest / (sb_real)def->cells : 1;
    grid->count[0] = sbi_max_int((int)(edge.x / grid->cell + (sb_real)0.999), 2) + 1;
    grid->count[1] = sbi_max_int((int)(edge.y / grid->cell + (sb_real)0.999), 2) + 1;
    grid->count[2] = sbi_max_int((int)(edge.z / grid->cell + (sb_real)0.999), 2) + 1;
    return 1;
}

static sb_result regi_field_make_grid(reg_field *field, const reg_field_def *def, sb_error *error)
{
    regi_field_filling filling;
    size_t corners;
    if (!regi_field_plan(field, def))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the target is too large for a potential");
    corners = (size_t)field->grid.count[0] * (size_t)field->grid.count[1] * (size_t)field->grid.count[2];
    field->grid.phi = (sb_real *)sbi_alloc(&field->allocator, corners, sizeof(sb_real));
    filling.field = field;
    filling.held = (unsigned char *)sbi_alloc(&field->allocator, corners, 1);
    if (!field->grid.phi || !filling.held) {
        sbi_free(&field->allocator, filling.held);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a potential of %d cells a side", def->cells);
    }
    sbi_run(&def->jobs, regi_field_fill_row, &filling, field->grid.count[1] * field->grid.count[2]);
    regi_field_solve(&field->grid, filling.held);
    sbi_free(&field->allocator, filling.held);
    return SB_OK;
}

/* ---- life ---- */

REG_API sb_result reg_field_create(const reg_field_def *def, reg_field **field, sb_error *error)
{
    reg_field *made;
    sb_result result = regi_field_check(def, error);
    if (result == SB_OK && !field)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "there is no place for the field");
    if (result != SB_OK)
        return result;
    made = (reg_field *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a field");
    made->allocator = def->allocator;
    made->kind = def->kind;
    result =
        def->surface ? regi_field_make_surface(made, def->surface, error) : regi_field_make_cloud(made, def, error);
    if (result == SB_OK && def->kind == REG_FIELD_LAPLACE)
        result = regi_field_make_grid(made, def, error);
    if (result != SB_OK) {
        reg_field_destroy(made);
        return result;
    }
    *field = made;
    return SB_OK;
}

/* ---- the potential ---- */

REG_API int reg_field_at(const reg_field *field, sb_vec3 point, int guess, sb_real *phi, sb_vec3 *gradient)
{
    reg_field_hit hit;
    sb_vec3 slope = sb_v3(0, 0, 0);
    if (!field || !phi)
        return 0;
    if (field->kind == REG_FIELD_LAPLACE) {
        if (!sb_v3_is_finite(point))
            return 0;
        *phi = regi_field_interpolate(&field->grid, point, &slope);
    } else {
        if (!reg_field_closest(field, point, guess, &hit))
            return 0;
        *phi = hit.distance;
        if (hit.distance > 0)
            slope = sb_v3_scale((sb_real)1 / hit.distance, sb_v3_sub(point, hit.point));
    }
    if (gradient)
        *gradient = slope;
    return 1;
}

REG_API int reg_field_along(const reg_field *field, sb_vec3 point, sb_vec3 direction, sb_real step, int guess,
                            reg_field_sample *sample)
{
    sb_real half = (sb_real)0.5 * step, before, after, phi;
    sb_vec3 slope_before, slope_after;
    if (!field || !sample)
        return 0;
    if (!reg_field_at(field, point, guess, &phi, NULL) ||
        !reg_field_at(field, sb_v3_madd(point, -half, direction), guess, &before, &slope_before) ||
        !reg_field_at(field, sb_v3_madd(point, half, direction), guess, &after, &slope_after))
        return 0;
    sample->phi = phi;
    sample->phi_n = (after - before) / step;
    sample->phi_nn = sb_v3_dot(direction, sb_v3_sub(slope_after, slope_before)) / step;
    return 1;
}

REG_API void reg_field_bounds(const reg_field *field, sb_vec3 *low, sb_vec3 *high)
{
    if (!field || !low || !high)
        return;
    *low = field->low;
    *high = field->high;
}

REGI_API int regi_field_is_open(const reg_field *field)
{
    int triangles = field->surface ? sb_surface_triangle_count(field->surface) : 0;
    for (int t = 0; t < triangles; t++)
        if (field->border[t])
            return 1;
    return field->tree != NULL;
}

REG_API int reg_field_sweeps(const reg_field *field) { return field ? field->grid.sweeps : 0; }
