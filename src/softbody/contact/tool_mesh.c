/* tool_mesh: the grid of distances of a closed surface: laid out, filled, asked. */
#include "tool_mesh.h"

#include "tool_private.h"

/* Cells between the surface's box and where the function ends, and nodes that it needs beyond. */
enum { SBI_TOOL_GRID_MARGIN = 2, SBI_TOOL_GRID_RIM = 1 };

/* A gradient shorter than this may be nothing but the rounding of distances to float. */
#define SBI_TOOL_LEAST_SLOPE ((sb_real)1e-4)

/* ---- layout ---- */

static sb_result sbi_tool_grid_check(const sb_tool_def *def, const sb_allocator *allocator, sb_error *error)
{
    sb_error cause;
    sb_result result;
    if (!def->surface)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.surface is NULL");
    if (def->cells < SB_TOOL_MIN_CELLS || def->cells > SB_TOOL_MAX_CELLS)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.cells %d must be in [%d, %d]", def->cells, SB_TOOL_MIN_CELLS,
                        SB_TOOL_MAX_CELLS);
    if (def->surface->element_type != SB_TRI3)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "def.surface must be of tri3: sb_surface_triangulate makes them");
    result = sb_surface_require(def->surface, SB_SURFACE_NOT_SOLID, allocator, NULL, &cause);
    if (result == SB_OK)
        return SB_OK;
    sbi_fail(error, result, "def.surface must be closed and look outward: %.180s", cause.message);
    if (error)
        error->element = cause.element, error->node = cause.node;
    return result;
}

/* Nodes along an axis whose cells cover `side` and the margins. Room that is a rounding error gets no cell. */
static int sbi_tool_grid_axis(sb_real side, sb_real cell)
{
    int cells = (int)(side / cell + (sb_real)0.999);
    return sbi_max_int(cells, 1) + 2 * (SBI_TOOL_GRID_MARGIN + SBI_TOOL_GRID_RIM) + 1;
}

/* The grid round surface_low ... surface_high. */
static sb_result sbi_tool_grid_place(sbi_tool_grid *grid, int cells, sb_error *error)
{
    sb_vec3 side = sb_v3_sub(grid->surface_high, grid->surface_low), nodes;
    sb_real longest = sb_max(side.x, sb_max(side.y, side.z));
    sb_real far =
        sb_max(sbi_tool_largest_coordinate(grid->surface_low), sbi_tool_largest_coordinate(grid->surface_high));
    grid->cell = longest / (sb_real)cells;
    if (!(longest >= SBI_TOOL_LEAST_LENGTH) || !(far <= SBI_TOOL_MOST_LENGTH) ||
        !(grid->cell >= 64 * SB_EPSILON * far)) /* coordinates are exact to a small part of a cell */
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.surface, %g m long and up to %g m off, is too small or too far",
                        (double)longest, (double)far);
    grid->counts[0] = sbi_tool_grid_axis(side.x, grid->cell);
    grid->counts[1] = sbi_tool_grid_axis(side.y, grid->cell);
    grid->counts[2] = sbi_tool_grid_axis(side.z, grid->cell);
    nodes = sb_v3((sb_real)(grid->counts[0] - 1), (sb_real)(grid->counts[1] - 1), (sb_real)(grid->counts[2] - 1));
    grid->low = sb_v3_madd(grid->surface_low, (sb_real)0.5, sb_v3_madd(side, -grid->cell, nodes));
    return SB_OK;
}

SBI_API sb_result sbi_tool_grid_lay_out(const sb_tool_def *def, const sb_allocator *allocator, sb_surface **surface,
                                        sbi_tool_grid *grid, sb_error *error)
{
    sb_surface *made;
    sb_result result = sbi_tool_grid_check(def, allocator, error);
    if (result == SB_OK)
        result = sb_surface_create(def->surface, allocator, &made, error);
    if (result != SB_OK)
        return result;
    memset(grid, 0, sizeof *grid);
    sb_surface_bounds(made, &grid->surface_low, &grid->surface_high);
    result = sbi_tool_grid_place(grid, def->cells, error);
    if (result == SB_OK)
        *surface = made;
    else
        sb_surface_destroy(made);
    return result;
}

SBI_API size_t sbi_tool_grid_node_count(const sbi_tool_grid *grid)
{
    return (size_t)grid->counts[0] * (size_t)grid->counts[1] * (size_t)grid->counts[2];
}

static sb_vec3 sbi_tool_grid_node(const sbi_tool_grid *grid, size_t node)
{
    size_t x = node % (size_t)grid->counts[0], row = node / (size_t)grid->counts[0];
    size_t y = row % (size_t)grid->counts[1], z = row / (size_t)grid->counts[1];
    return sb_v3_madd(grid->low, grid->cell, sb_v3((sb_real)x, (sb_real)y, (sb_real)z));
}

/* ---- skeleton ---- */

/* Of the nodes that are at least so deep, those connected along the axes with `node` are marked; *low and *high are
 * their box. queue[nodes]. */
static void sbi_tool_grid_flood(const sbi_tool_grid *grid, float deepest, size_t node, unsigned char *marks, int *queue,
                                sb_vec3 *low, sb_vec3 *high)
{
    const int steps[3] = {1, grid->counts[0], grid->counts[0] * grid->counts[1]};
    int first = 0, last = 0;
    memset(marks, 0, sbi_tool_grid_node_count(grid));
    *low = *high = sbi_tool_grid_node(grid, node);
    marks[node] = 1;
    queue[last++] = (int)node;
    while (first < last) {
        int at = queue[first++];
        sb_vec3 x = sbi_tool_grid_node(grid, (size_t)at);
        *low = sb_v3(sb_min(low->x, x.x), sb_min(low->y, x.y), sb_min(low->z, x.z));
        *high = sb_v3(sb_max(high->x, x.x), sb_max(high->y, x.y), sb_max(high->z, x.z));
        for (int k = 0; k < 6; k++) { /* nodes at the grid's ends are outside, so that neighbours exist */
            int next = k < 3 ? at + steps[k] : at - steps[k - 3];
            if (marks[next] || grid->distances[next] > deepest)
                continue;
            marks[next] = 1;
            queue[last++] = next;
        }
    }
}

/* How deep the skeleton is: as deep as may be if it is to be in one piece and to reach within two of that depth of each
 * side of the tool's box, so that a shaft counts beside a thick grip; one cell where that does not come to pass. */
static sb_real sbi_tool_grid_find_depth(const sbi_tool_grid *grid, size_t deepest, unsigned char *marks, int *queue)
{
    sb_real depth = (sb_real)0.9 * -(sb_real)grid->distances[deepest] * grid->cell;
    for (; depth > grid->cell; depth *= (sb_real)0.8) {
        sb_vec3 low, high, before, behind;
        sbi_tool_grid_flood(grid, (float)(-depth / grid->cell), deepest, marks, queue, &low, &high);
        before = sb_v3_sub(low, grid->surface_low);
        behind = sb_v3_sub(grid->surface_high, high);
        if (sb_max(sb_max(before.x, sb_max(before.y, before.z)), sb_max(behind.x, sb_max(behind.y, behind.z))) <=
            2 * depth)
            return depth;
    }
    return grid->cell;
}

/* Is a node of the skeleton, or even one that has neighbours that are not? */
static int sbi_tool_grid_is_deep(const sbi_tool_grid *grid, size_t node, sb_real depth)
{
    return (sb_real)grid->distances[node] * grid->cell <= -depth;
}
static int sbi_tool_grid_is_hull(const sbi_tool_grid *grid, size_t node, sb_real depth)
{
    const size_t steps[3] = {1, (size_t)grid->counts[0], (size_t)grid->counts[0] * (size_t)grid->counts[1]};
    int inner = 1;
    if (!sbi_tool_grid_is_deep(grid, node, depth))
        return 0;
    for (int k = 0; k < 3; k++)
        inner = inner && sbi_tool_grid_is_deep(grid, node + steps[k], depth) &&
                sbi_tool_grid_is_deep(grid, node - steps[k], depth);
    return !inner;
}

/* The box of the nodes that are deep enough, and some of those at its hull. */
static void sbi_tool_grid_find_skeleton(sbi_tool_grid *grid)
{
    size_t count = sbi_tool_grid_node_count(grid), hull = 0, taken = 0, stride;
    for (size_t i = 0; i < count; i++)
        hull += (size_t)sbi_tool_grid_is_hull(grid, i, grid->inner_radius);
    stride = (hull + SBI_TOOL_MAX_SKELETON - 1) / SBI_TOOL_MAX_SKELETON;
    grid->skeleton_low = sb_v3(SB_REAL_MAX, SB_REAL_MAX, SB_REAL_MAX);
    grid->skeleton_high = sb_v3_scale(-1, grid->skeleton_low);
    for (size_t i = 0; i < count; i++) {
        sb_vec3 x, *low = &grid->skeleton_low, *high = &grid->skeleton_high;
        if (!sbi_tool_grid_is_hull(grid, i, grid->inner_radius))
            continue;
        x = sbi_tool_grid_node(grid, i);
        *low = sb_v3(sb_min(low->x, x.x), sb_min(low->y, x.y), sb_min(low->z, x.z));
        *high = sb_v3(sb_max(high->x, x.x), sb_max(high->y, x.y), sb_max(high->z, x.z));
        if (taken++ % stride == 0)
            grid->skeleton[grid->skeleton_count++] = x;
    }
}

/* ---- filling ---- */

static void sbi_tool_grid_fill_layer(sbi_tool_grid *grid, size_t layer, const sb_surface *surface, sb_vec3 *points,
                                     sb_real *distances, const sb_jobs *jobs)
{
    size_t count = (size_t)grid->counts[0] * (size_t)grid->counts[1], first = layer * count;
    for (size_t i = 0; i < count; i++)
        points[i] = sbi_tool_grid_node(grid, first + i);
    sb_surface_signed_distance_batch(surface, points, (int)count, distances, NULL, jobs);
    for (size_t i = 0; i < count; i++)
        grid->distances[first + i] = (float)(distances[i] / grid->cell);
}

SBI_API sb_result sbi_tool_grid_fill(sbi_tool_grid *grid, const sb_surface *surface, const sb_allocator *allocator,
                                     const sb_jobs *jobs, sb_error *error)
{
    size_t count = sbi_tool_grid_node_count(grid), layer = count / (size_t)grid->counts[2], deepest = 0;
    sb_vec3 *points = (sb_vec3 *)sbi_alloc(allocator, layer, sizeof(sb_vec3));
    sb_real *distances = (sb_real *)sbi_alloc(allocator, layer, sizeof(sb_real));
    unsigned char *marks = (unsigned char *)sbi_alloc(allocator, count, 1);
    int *queue = (int *)sbi_alloc(allocator, count, sizeof(int));
    sb_result result = SB_OK;
    if (points && distances && marks && queue) {
        for (int i = 0; i < grid->counts[2]; i++)
            sbi_tool_grid_fill_layer(grid, (size_t)i, surface, points, distances, jobs);
        for (size_t i = 1; i < count; i++)
            deepest = grid->distances[i] < grid->distances[deepest] ? i : deepest;
        if (grid->distances[deepest] > -1)
            result = sbi_fail(error, SB_ERROR_UNSUPPORTED,
                              "def.surface is thinner than two of its grid's cells of %g m: raise def.cells",
                              (double)grid->cell);
        else
            grid->inner_radius = sbi_tool_grid_find_depth(grid, deepest, marks, queue);
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "out of memory for a grid of %g nodes", (double)count);
    }
    if (result == SB_OK)
        sbi_tool_grid_find_skeleton(grid);
    sbi_free(allocator, points);
    sbi_free(allocator, distances);
    sbi_free(allocator, marks);
    sbi_free(allocator, queue);
    return result;
}

/* ---- distances ---- */

/* Weights of the four nodes about a point at share t between the middle two, and their slopes. */
SBI_FORCE_INLINE void sbi_tool_grid_weights(sb_real t, sb_real w[4], sb_real d[4])
{
    const sb_real half = (sb_real)0.5;
    w[0] = half * t * (t * (2 - t) - 1);
    w[1] = half * (t * t * (3 * t - 5) + 2);
    w[2] = half * t * (t * (4 - 3 * t) + 1);
    w[3] = half * t * t * (t - 1);
    d[0] = half * (t * (4 - 3 * t) - 1);
    d[1] = half * t * (9 * t - 10);
    d[2] = half * (t * (8 - 9 * t) + 1);
    d[3] = half * t * (3 * t - 2);
}

/* The function and its gradient, in cells; u in nodes along each axis, within the rim. */
SBI_FORCE_INLINE sb_real sbi_tool_grid_value(const sbi_tool_grid *grid, const sb_real u[3], sb_vec3 *gradient)
{
    sb_real w[3][4], d[3][4], row[4] = {0, 0, 0, 0}, row_y[4] = {0, 0, 0, 0}, row_z[4] = {0, 0, 0, 0};
    size_t at[3], stride_y = (size_t)grid->counts[0], stride_z = stride_y * (size_t)grid->counts[1];
    const float *nodes;
    for (int k = 0; k < 3; k++) {
        int cell = sbi_min_int((int)u[k], grid->counts[k] - 3);
        at[k] = (size_t)(cell - 1);
        sbi_tool_grid_weights(u[k] - (sb_real)cell, w[k], d[k]);
    }
    nodes = grid->distances + at[0] + at[1] * stride_y + at[2] * stride_z;
    for (int j = 0; j < 4; j++, nodes += stride_y) {
        const float *n0 = nodes, *n1 = n0 + stride_z, *n2 = n1 + stride_z, *n3 = n2 + stride_z;
        for (int i = 0; i < 4; i++) {
            sb_real a = (sb_real)n0[i], b = (sb_real)n1[i], c = (sb_real)n2[i], e = (sb_real)n3[i];
            sb_real along = (w[2][0] * a + w[2][1] * b) + (w[2][2] * c + w[2][3] * e);
            sb_real slope = (d[2][0] * a + d[2][1] * b) + (d[2][2] * c + d[2][3] * e);
            row[i] += w[1][j] * along;
            row_y[i] += d[1][j] * along;
            row_z[i] += w[1][j] * slope;
        }
    }
    gradient->x = (d[0][0] * row[0] + d[0][1] * row[1]) + (d[0][2] * row[2] + d[0][3] * row[3]);
    gradient->y = (w[0][0] * row_y[0] + w[0][1] * row_y[1]) + (w[0][2] * row_y[2] + w[0][3] * row_y[3]);
    gradient->z = (w[0][0] * row_z[0] + w[0][1] * row_z[1]) + (w[0][2] * row_z[2] + w[0][3] * row_z[3]);
    return (w[0][0] * row[0] + w[0][1] * row[1]) + (w[0][2] * row[2] + w[0][3] * row[3]);
}

/* Beyond the point where the grid ends, whose distance and normal are given, by e: the surface is on the other side of
 * a plane across e, so that it is at least as far as the two distances at right angles. The normal goes on from the
 * surface's point that is nearest to the grid's end. */
static sb_real sbi_tool_grid_beyond(sb_vec3 e, sb_real distance, sb_vec3 fallback, sb_vec3 *normal)
{
    sb_real square = sb_v3_dot(e, e);
    sb_vec3 unit;
    if (!(square <= (sb_real)0.25 * SB_REAL_MAX))
        return sbi_tool_extreme_distance(e, 0, fallback, normal);
    sbi_tool_round_distance(sb_v3_madd(e, distance, *normal), 0, 0, fallback, &unit);
    *normal = unit;
    return sb_sqrt(square + distance * distance);
}

/* x held within [low, high]; low for NaN. */
static sb_real sbi_tool_hold(sb_real x, sb_real low, sb_real high) { return x > low ? sb_min(x, high) : low; }

SBI_API sb_real sbi_tool_grid_distance(const sbi_tool_grid *grid, sb_vec3 x, sb_vec3 fallback, sb_vec3 *normal)
{
    const sb_real rim = (sb_real)SBI_TOOL_GRID_RIM, inverse = 1 / grid->cell;
    sb_vec3 from = sb_v3_scale(inverse, sb_v3_sub(x, grid->low)), slope, beyond;
    sb_real u[3], distance, square;
    u[0] = sbi_tool_hold(from.x, rim, (sb_real)(grid->counts[0] - 1) - rim);
    u[1] = sbi_tool_hold(from.y, rim, (sb_real)(grid->counts[1] - 1) - rim);
    u[2] = sbi_tool_hold(from.z, rim, (sb_real)(grid->counts[2] - 1) - rim);
    distance = grid->cell * sbi_tool_grid_value(grid, u, &slope);
    square = sb_v3_dot(slope, slope);
    *normal = fallback;
    if (square > SBI_TOOL_LEAST_SLOPE * SBI_TOOL_LEAST_SLOPE)
        *normal = sb_v3_scale((sb_real)1 / sb_sqrt(square), slope);
    if (u[0] == from.x && u[1] == from.y && u[2] == from.z)
        return distance;
    beyond = sb_v3_scale(grid->cell, sb_v3_sub(from, sb_v3(u[0], u[1], u[2])));
    return sbi_tool_grid_beyond(beyond, distance, fallback, normal);
}
