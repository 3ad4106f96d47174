/* tool: shapes checked, made, their distances, skeletons and motion. */
#include <string.h>

#include "tool_private.h"

#define SBI_TOOL_COOKIE 0x7001u

SB_API sb_tool_def sb_default_tool_def(void)
{
    sb_tool_def def;
    memset(&def, 0, sizeof def);
    def.shape = SB_TOOL_SPHERE;
    def.cells = 48;
    def.pose.rotation = sb_quat_identity();
    def.max_force = SB_REAL_MAX;
    def.cookie = SBI_TOOL_COOKIE;
    return def;
}

/* ---- checks ---- */

SBI_API sb_result sbi_tool_pose_check(const sb_pose *pose, const char *name, sb_pose *unit, sb_error *error)
{
    sb_quat q;
    if (!pose)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", name);
    q = pose->rotation;
    if (!sb_v3_is_finite(pose->position))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "%s.position is not finite", name);
    if (!sb_is_finite(q.w) || !sb_is_finite(q.x) || !sb_is_finite(q.y) || !sb_is_finite(q.z))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "%s.rotation is not finite", name);
    if (q.w == 0 && q.x == 0 && q.y == 0 && q.z == 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s.rotation is 0, no quaternion of a rotation", name);
    if (unit) {
        unit->position = pose->position;
        unit->rotation = sb_quat_normalise(q);
    }
    return SB_OK;
}

static sb_result sbi_tool_check_length(sb_real length, const char *name, sb_error *error)
{
    if (!sb_is_finite(length))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "%s is not finite", name);
    if (!(length >= SBI_TOOL_LEAST_LENGTH) || !(length <= SBI_TOOL_MOST_LENGTH))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s %g must be in [%g, %g] m", name, (double)length,
                        (double)SBI_TOOL_LEAST_LENGTH, (double)SBI_TOOL_MOST_LENGTH);
    return SB_OK;
}

SBI_API sb_result sbi_tool_chain_check(const sb_vec3 *points, int count, sb_real radius, const char *name,
                                       sb_error *error)
{
    if (!points || count < 2 || count > SB_TOOL_MAX_POINTS)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL, or its count %d not in [2, %d]", name, count,
                        SB_TOOL_MAX_POINTS);
    for (int i = 0; i < count; i++) {
        sb_real size = sbi_tool_largest_coordinate(points[i]), least;
        if (!sb_v3_is_finite(points[i]))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "%s[%d] is not finite", name, i);
        if (!(size <= SBI_TOOL_MOST_LENGTH))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "%s[%d] is farther than %g m from the tool's origin", name, i,
                            (double)SBI_TOOL_MOST_LENGTH);
        least = 4 * SB_EPSILON * sb_max(size, radius); /* their distance is then more than a rounding error */
        if (i > 0 && !(sb_v3_norm(sb_v3_sub(points[i], points[i - 1])) > least))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "%s[%d] and %s[%d] coincide", name, i - 1, name, i);
    }
    return SB_OK;
}

static sb_result sbi_tool_check_box(const sb_tool_def *def, sb_error *error)
{
    sb_real least = sb_min(def->half.x, sb_min(def->half.y, def->half.z));
    sb_result result = sbi_tool_check_length(def->half.x, "def.half.x", error);
    if (result == SB_OK)
        result = sbi_tool_check_length(def->half.y, "def.half.y", error);
    if (result == SB_OK)
        result = sbi_tool_check_length(def->half.z, "def.half.z", error);
    if (result == SB_OK && def->radius != 0)
        result = sbi_tool_check_length(def->radius, "def.radius", error);
    if (result == SB_OK && def->radius > least)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.radius %g exceeds the smallest of def.half, %g",
                        (double)def->radius, (double)least);
    return result;
}

static sb_result sbi_tool_check_shape(const sb_tool_def *def, sb_error *error)
{
    sb_result result;
    switch (def->shape) {
    case SB_TOOL_SPHERE: return sbi_tool_check_length(def->radius, "def.radius", error);
    case SB_TOOL_CAPSULES:
        result = sbi_tool_check_length(def->radius, "def.radius", error);
        if (result == SB_OK)
            result = sbi_tool_chain_check(def->points, def->point_count, def->radius, "def.points", error);
        return result;
    case SB_TOOL_BOX: return sbi_tool_check_box(def, error);
    case SB_TOOL_PLANE:
    case SB_TOOL_MESH: return SB_OK; /* its surface is checked when its grid is laid out */
    default: return sbi_fail(error, SB_ERROR_ARGUMENT, "def.shape %d is unknown", (int)def->shape);
    }
}

static sb_result sbi_tool_check_not_negative(sb_real value, const char *name, sb_error *error)
{
    if (!sb_is_finite(value))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "%s is not finite", name);
    if (!(value >= 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s %g must be >= 0", name, (double)value);
    return SB_OK;
}

static sb_result sbi_tool_check_spring(const sb_tool_def *def, sb_error *error)
{
    sb_result result = sbi_tool_check_not_negative(def->coupling_stiffness, "def.coupling_stiffness", error);
    if (result == SB_OK)
        result = sbi_tool_check_not_negative(def->coupling_turning, "def.coupling_turning", error);
    if (result == SB_OK)
        result = sbi_tool_check_not_negative(def->max_force, "def.max_force", error);
    if (result == SB_OK && def->max_force == 0)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "def.max_force is 0: the spring must pull with some force");
    if (result == SB_OK && def->coupling_turning > 0 && def->coupling_stiffness == 0)
        result = sbi_fail(error, SB_ERROR_ARGUMENT,
                          "def.coupling_turning needs def.coupling_stiffness > 0: a tool without it is rigid");
    return result;
}

static sb_result sbi_tool_check_def(const sb_tool_def *def, sb_error *error)
{
    sb_result result;
    if (def->cookie != SBI_TOOL_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by sb_default_tool_def");
    result = sbi_tool_check_not_negative(def->friction, "def.friction", error);
    if (result == SB_OK)
        result = sbi_tool_check_spring(def, error);
    if (result == SB_OK)
        result = sbi_tool_pose_check(&def->pose, "def.pose", NULL, error);
    return result == SB_OK ? sbi_tool_check_shape(def, error) : result;
}

/* ---- life ---- */

static sbi_tool_segment sbi_tool_make_segment(sb_vec3 a, sb_vec3 b)
{
    sbi_tool_segment segment;
    segment.a = a;
    segment.way = sb_v3_sub(b, a);
    segment.inverse = (sb_real)1 / sb_v3_dot(segment.way, segment.way);
    return segment;
}

/* The tool and its arrays in one block; the tool comes first. */
static sbi_tool *sbi_tool_lay_out(sbi_arena *arena, int point_count, const sbi_tool_grid *grid)
{
    size_t nodes = sbi_tool_grid_node_count(grid), hull = nodes > 0 ? SBI_TOOL_MAX_SKELETON : 0;
    sbi_tool *tool = (sbi_tool *)sbi_arena_take(arena, 1, sizeof(sbi_tool));
    sb_vec3 *points = (sb_vec3 *)sbi_arena_take(arena, (size_t)point_count, sizeof(sb_vec3));
    sbi_tool_segment *segments =
        (sbi_tool_segment *)sbi_arena_take(arena, (size_t)point_count, sizeof(sbi_tool_segment));
    sb_vec3 *skeleton = (sb_vec3 *)sbi_arena_take(arena, hull, sizeof(sb_vec3));
    float *distances = (float *)sbi_arena_take(arena, nodes, sizeof(float));
    if (!arena->base)
        return NULL;
    memset(tool, 0, sizeof *tool);
    tool->point_count = point_count;
    tool->points = points;
    tool->segments = segments;
    tool->grid = *grid;
    tool->grid.skeleton = skeleton;
    tool->grid.distances = distances;
    return tool;
}

/* Two points are nearer to each other than this where that may be their rounding. */
static sb_real sbi_tool_rounding(const sbi_tool *tool)
{
    sb_real size = tool->radius;
    for (int i = 0; i < tool->point_count; i++)
        size = sb_max(size, sbi_tool_largest_coordinate(tool->points[i]));
    return 4 * SB_EPSILON * size;
}

static void sbi_tool_set_shape(sbi_tool *tool, const sb_tool_def *def)
{
    tool->shape = def->shape;
    tool->radius = def->radius;
    if (def->shape == SB_TOOL_PLANE)
        tool->radius = SB_REAL_MAX;
    if (def->shape == SB_TOOL_BOX) {
        if (def->radius == 0)
            tool->radius = (sb_real)0.1 * sb_min(def->half.x, sb_min(def->half.y, def->half.z));
        tool->core = sb_v3_sub(def->half, sb_v3(tool->radius, tool->radius, tool->radius));
    }
    tool->inner_radius = tool->radius;
    for (int i = 0; i < tool->point_count; i++)
        tool->points[i] = def->points[i];
    for (int i = 0; i + 1 < tool->point_count; i++)
        tool->segments[i] = sbi_tool_make_segment(def->points[i], def->points[i + 1]);
    if (def->shape != SB_TOOL_PLANE)
        tool->least_square = sbi_tool_rounding(tool) * sbi_tool_rounding(tool);
}

/* The tool without what its surface makes of it, or NULL. */
static sbi_tool *sbi_tool_allocate(const sb_tool_def *def, const sb_allocator *allocator, const sbi_tool_grid *grid)
{
    int point_count = def->shape == SB_TOOL_CAPSULES ? def->point_count : 0;
    sbi_arena arena = {NULL, 0, 0};
    sbi_tool *tool;
    sbi_tool_lay_out(&arena, point_count, grid);
    arena.base = arena.overflow ? NULL : (unsigned char *)sbi_alloc(allocator, arena.used, 1);
    if (!arena.base)
        return NULL;
    arena.used = 0;
    tool = sbi_tool_lay_out(&arena, point_count, grid);
    if (allocator)
        tool->allocator = *allocator;
    sbi_tool_set_shape(tool, def);
    return tool;
}

static sb_result sbi_tool_take_surface(sbi_tool *tool, const sb_surface *surface, const sb_jobs *jobs, sb_error *error)
{
    sb_result result = sbi_tool_grid_fill(&tool->grid, surface, &tool->allocator, jobs, error);
    tool->inner_radius = tool->grid.inner_radius;
    tool->radius = sb_min(2 * tool->grid.cell, tool->inner_radius);
    return result;
}

SBI_API sb_result sbi_tool_create(const sb_tool_def *def, const sb_allocator *allocator, const sb_jobs *jobs,
                                  sbi_tool **tool, sb_error *error)
{
    sbi_tool_grid grid;
    sb_surface *surface = NULL;
    sbi_tool *made;
    sb_result result;
    memset(&grid, 0, sizeof grid);
    if (!def || !tool)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a required pointer is NULL");
    result = sbi_tool_check_def(def, error);
    if (result == SB_OK && def->shape == SB_TOOL_MESH)
        result = sbi_tool_grid_lay_out(def, allocator, &surface, &grid, error);
    if (result != SB_OK)
        return result;
    made = sbi_tool_allocate(def, allocator, &grid);
    if (!made)
        result = sbi_fail(error, SB_ERROR_MEMORY, "out of memory for a tool");
    else if (surface)
        result = sbi_tool_take_surface(made, surface, jobs, error);
    sb_surface_destroy(surface);
    if (result == SB_OK)
        *tool = made;
    else
        sbi_tool_destroy(made);
    return result;
}

SBI_API void sbi_tool_destroy(sbi_tool *tool)
{
    sb_allocator allocator;
    if (!tool)
        return;
    allocator = tool->allocator;
    sbi_free(&allocator, tool);
}

SBI_API sb_tool_shape sbi_tool_get_shape(const sbi_tool *tool) { return tool->shape; }
SBI_API int sbi_tool_point_count(const sbi_tool *tool) { return tool->point_count; }
SBI_API sb_real sbi_tool_radius(const sbi_tool *tool) { return tool->radius; }
SBI_API int sbi_tool_is_exact(const sbi_tool *tool) { return tool->shape != SB_TOOL_MESH; }
SBI_API sb_real sbi_tool_inner_radius(const sbi_tool *tool) { return tool->inner_radius; }

/* ---- distances ---- */

/* From the point of a segment that is nearest to x, to x. */
SBI_FORCE_INLINE sb_vec3 sbi_tool_from_segment(const sbi_tool_segment *segment, sb_vec3 x)
{
    sb_vec3 d = sb_v3_sub(x, segment->a);
    sb_real share = sb_v3_dot(d, segment->way) * segment->inverse;
    share = sb_min(sb_max(share, 0), 1);
    return sb_v3_madd(d, -share, segment->way);
}

/* Of segments equally near, the first one counts. */
SBI_FORCE_INLINE sb_real sbi_tool_capsules_distance(const sbi_tool *tool, const sbi_tool_segment *segments, sb_vec3 x,
                                                    sb_vec3 fallback, sb_vec3 *normal)
{
    sb_vec3 nearest = sbi_tool_from_segment(segments, x);
    sb_real least = sb_v3_dot(nearest, nearest);
    for (int i = 1; i + 1 < tool->point_count; i++) {
        sb_vec3 d = sbi_tool_from_segment(segments + i, x);
        sb_real square = sb_v3_dot(d, d);
        nearest = square < least ? d : nearest;
        least = square < least ? square : least;
    }
    return sbi_tool_round_distance(nearest, tool->radius, tool->least_square, fallback, normal);
}

/* Inside the core of a box, or x is no number: towards its nearest side. */
static sb_real sbi_tool_core_distance(const sbi_tool *tool, sb_vec3 x, sb_vec3 q, sb_vec3 fallback, sb_vec3 *normal)
{
    sb_real along = x.x, outward = q.x;
    sb_vec3 axis = sb_v3(1, 0, 0);
    if (q.y > outward)
        along = x.y, outward = q.y, axis = sb_v3(0, 1, 0);
    if (q.z > outward)
        along = x.z, outward = q.z, axis = sb_v3(0, 0, 1);
    *normal = fallback;
    if (!sb_v3_is_finite(x))
        return SB_REAL_MAX;
    if (along * along > tool->least_square)
        *normal = along < 0 ? sb_v3_scale(-1, axis) : axis;
    return outward - tool->radius;
}

SBI_FORCE_INLINE sb_real sbi_tool_box_distance(const sbi_tool *tool, sb_vec3 x, sb_vec3 fallback, sb_vec3 *normal)
{
    sb_vec3 q = sb_v3(sb_abs(x.x) - tool->core.x, sb_abs(x.y) - tool->core.y, sb_abs(x.z) - tool->core.z), d;
    sb_real square;
    d = sb_v3(q.x < 0 ? 0 : q.x, q.y < 0 ? 0 : q.y, q.z < 0 ? 0 : q.z); /* NaN stays */
    square = sb_v3_dot(d, d);
    if (!(square > tool->least_square))
        return sbi_tool_core_distance(tool, x, q, fallback, normal);
    d = sb_v3(x.x < 0 ? -d.x : d.x, x.y < 0 ? -d.y : d.y, x.z < 0 ? -d.z : d.z);
    return sbi_tool_round_distance(d, tool->radius, tool->least_square, fallback, normal);
}

static sb_real sbi_tool_plane_distance(sb_vec3 x, sb_vec3 fallback, sb_vec3 *normal)
{
    *normal = sb_v3_is_finite(x) ? sb_v3(0, 0, 1) : fallback;
    return sb_v3_is_finite(x) ? x.z : SB_REAL_MAX;
}

/* Segments of a chain that replaces the tool's own, or these where it is the same; memory[SB_TOOL_MAX_POINTS]. */
static const sbi_tool_segment *sbi_tool_find_segments(const sbi_tool *tool, const sb_vec3 *chain,
                                                      sbi_tool_segment *memory)
{
    if (!chain || memcmp(chain, tool->points, (size_t)tool->point_count * sizeof *chain) == 0)
        return tool->segments;
    for (int i = 0; i + 1 < tool->point_count; i++)
        memory[i] = sbi_tool_make_segment(chain[i], chain[i + 1]);
    return memory;
}

SBI_API sb_real sbi_tool_distance(const sbi_tool *tool, const sb_vec3 *chain, sb_vec3 x, sb_vec3 fallback,
                                  sb_vec3 *normal)
{
    sbi_tool_segment memory[SB_TOOL_MAX_POINTS];
    switch (tool->shape) {
    case SB_TOOL_SPHERE: return sbi_tool_round_distance(x, tool->radius, tool->least_square, fallback, normal);
    case SB_TOOL_CAPSULES:
        return sbi_tool_capsules_distance(tool, sbi_tool_find_segments(tool, chain, memory), x, fallback, normal);
    case SB_TOOL_BOX: return sbi_tool_box_distance(tool, x, fallback, normal);
    case SB_TOOL_MESH: return sbi_tool_grid_distance(&tool->grid, x, fallback, normal);
    default: return sbi_tool_plane_distance(x, fallback, normal);
    }
}

SBI_API void sbi_tool_distances(const sbi_tool *tool, const sb_vec3 *chain, int count, const sb_vec3 *x,
                                const sb_vec3 *fallback, sb_real *gap, sb_vec3 *normal)
{
    sbi_tool_segment memory[SB_TOOL_MAX_POINTS];
    const sbi_tool_segment *segments;
    if (tool->shape != SB_TOOL_CAPSULES) {
        for (int i = 0; i < count; i++)
            gap[i] = sbi_tool_distance(tool, NULL, x[i], fallback[i], normal + i);
        return;
    }
    segments = sbi_tool_find_segments(tool, chain, memory);
    for (int i = 0; i < count; i++)
        gap[i] = sbi_tool_capsules_distance(tool, segments, x[i], fallback[i], normal + i);
}

/* ---- skeleton, bounds, motion ---- */

static sb_vec3 sbi_tool_corner(sb_vec3 low, sb_vec3 high, int corner)
{
    return sb_v3(corner & 1 ? high.x : low.x, corner & 2 ? high.y : low.y, corner & 4 ? high.z : low.z);
}

/* Points whose hull holds the skeleton: how many, and one of them. */
static int sbi_tool_hull_count(const sbi_tool *tool)
{
    switch (tool->shape) {
    case SB_TOOL_SPHERE: return 1;
    case SB_TOOL_CAPSULES: return tool->point_count;
    case SB_TOOL_PLANE: return 0;
    default: return 8;
    }
}
static sb_vec3 sbi_tool_hull_point(const sbi_tool *tool, const sb_vec3 *chain, int i)
{
    switch (tool->shape) {
    case SB_TOOL_CAPSULES: return (chain ? chain : tool->points)[i];
    case SB_TOOL_BOX: return sbi_tool_corner(sb_v3_scale(-1, tool->core), tool->core, i);
    case SB_TOOL_MESH: return sbi_tool_corner(tool->grid.skeleton_low, tool->grid.skeleton_high, i);
    default: return sb_v3(0, 0, 0);
    }
}

SBI_API int sbi_tool_skeleton(const sbi_tool *tool, const sb_vec3 *chain, sb_vec3 *points, int capacity)
{
    int is_mesh = tool->shape == SB_TOOL_MESH;
    int count = is_mesh ? tool->grid.skeleton_count : sbi_tool_hull_count(tool);
    for (int i = 0; i < count && i < capacity; i++)
        points[i] = is_mesh ? tool->grid.skeleton[i] : sbi_tool_hull_point(tool, chain, i);
    return count;
}

SBI_API int sbi_tool_segments(const sbi_tool *tool, int (*ends)[2], int capacity)
{
    int count = 0;
    for (int i = 0; i + 1 < tool->point_count; i++, count++)
        if (count < capacity)
            ends[count][0] = i, ends[count][1] = i + 1;
    for (int i = 0; i < 8 && tool->shape == SB_TOOL_BOX; i++)
        for (int axis = 1; axis < 8; axis *= 2) {
            if (i & axis)
                continue;
            if (count < capacity)
                ends[count][0] = i, ends[count][1] = i | axis;
            count++;
        }
    return count;
}

SBI_API void sbi_tool_bounds(const sbi_tool *tool, const sb_vec3 *chain, const sb_pose *pose, sb_vec3 *low,
                             sb_vec3 *high)
{
    const sbi_tool_grid *grid = &tool->grid;
    int is_mesh = tool->shape == SB_TOOL_MESH, count = sbi_tool_hull_count(tool);
    sb_real wider = is_mesh ? grid->cell : tool->radius,
            far = 0; /* a mesh: its function rounds what it passes through */
    *low = sb_v3(SB_REAL_MAX, SB_REAL_MAX, SB_REAL_MAX);
    *high = sb_v3_scale(-1, *low);
    if (count == 0) { /* a plane */
        *high = *low;
        *low = sb_v3_scale(-1, *high);
        return;
    }
    for (int i = 0; i < count; i++) {
        sb_vec3 p =
            is_mesh ? sbi_tool_corner(grid->surface_low, grid->surface_high, i) : sbi_tool_hull_point(tool, chain, i);
        p = sbi_pose_to_space(pose, p);
        *low = sb_v3(sb_min(low->x, p.x), sb_min(low->y, p.y), sb_min(low->z, p.z));
        *high = sb_v3(sb_max(high->x, p.x), sb_max(high->y, p.y), sb_max(high->z, p.z));
        far = sb_max(far, sbi_tool_largest_coordinate(p));
    }
    wider += 16 * SB_EPSILON * (far + wider); /* the points' own rounding */
    *low = sb_v3_sub(*low, sb_v3(wider, wider, wider));
    *high = sb_v3_add(*high, sb_v3(wider, wider, wider));
}

/* A point c of the tool on the way p(s) = position(s) + rotation(s) c(s). With the rotation's angle a, |p''| <= m =
 * a^2 |c| + 2 a |c1 - c0|, so that its speed differs from that of the straight way by m / 2 at most; nor is it larger
 * than the sum of the parts' speeds. */
static sb_real sbi_tool_point_motion(const sb_pose *from, sb_vec3 c0, const sb_pose *to, sb_vec3 c1, sb_real angle)
{
    sb_real bend = sb_v3_norm(sb_v3_sub(c1, c0)), size = sb_max(sb_v3_norm(c0), sb_v3_norm(c1));
    sb_real straight = sb_v3_norm(sb_v3_sub(sbi_pose_to_space(to, c1), sbi_pose_to_space(from, c0)));
    sb_real parts = sb_v3_norm(sb_v3_sub(to->position, from->position)) + angle * size + bend;
    return sb_min(straight + angle * ((sb_real)0.5 * angle * size + bend), parts);
}

SBI_API sb_real sbi_tool_motion(const sbi_tool *tool, const sb_vec3 *chain0, const sb_pose *from, const sb_vec3 *chain1,
                                const sb_pose *to)
{
    sb_real angle = sb_v3_norm(sbi_pose_rotation(from, to)), most = 0;
    for (int i = 0; i < sbi_tool_hull_count(tool); i++) /* between them all is between their motions */
        most = sb_max(most, sbi_tool_point_motion(from, sbi_tool_hull_point(tool, chain0, i), to,
                                                  sbi_tool_hull_point(tool, chain1, i), angle));
    return most;
}

/* Of a tool's radius: more than rounding may move a point by where it is. Ways end before a gap of 0.05 of it is used
 * up (contact_sweep.c), and take two such roundings. */
#define SBI_TOOL_ROUNDED ((sb_real)0.01)

SBI_API sb_result sbi_tool_place_check(const sbi_tool *tool, const sb_vec3 *chain, const sb_pose *pose,
                                       const char *name, sb_error *error)
{
    const sb_real radius = sb_min(tool->radius, SBI_TOOL_MOST_LENGTH); /* a plane's has no bound */
    const sb_real most = sb_min(SBI_TOOL_MOST_LENGTH, SBI_TOOL_ROUNDED / SB_EPSILON * radius);
    sb_real far = sbi_tool_largest_coordinate(pose->position);
    for (int i = 0; i < sbi_tool_hull_count(tool); i++)
        far = sb_max(far, sbi_tool_largest_coordinate(sbi_pose_to_space(pose, sbi_tool_hull_point(tool, chain, i))));
    if (far <= most)
        return SB_OK;
    return sbi_fail(error, SB_ERROR_ARGUMENT,
                    "%s takes the tool too far: %g m from the origin, where rounding is no longer small beside its "
                    "radius; at most %g m",
                    name, (double)far, (double)most);
}

/* ---- poses ---- */

SBI_API sb_vec3 sbi_pose_rotation(const sb_pose *from, const sb_pose *to)
{
    sb_quat turn = sb_quat_mul(sb_quat_conjugate(from->rotation), to->rotation);
    sb_vec3 axis = turn.w < 0 ? sb_v3(-turn.x, -turn.y, -turn.z) : sb_v3(turn.x, turn.y, turn.z);
    sb_real sine = sb_v3_norm(axis);
    return sb_v3_scale(sine > 0 ? 2 * sb_atan2(sine, sb_abs(turn.w)) / sine : 2, axis);
}

SBI_API sb_pose sbi_pose_between(const sb_pose *from, const sb_pose *to, sb_real share)
{
    sb_pose pose;
    sb_vec3 turn;
    if (share <= 0)
        return *from;
    if (share >= 1)
        return *to;
    turn = sb_v3_scale(share, sbi_pose_rotation(from, to));
    pose.position = sb_v3_madd(from->position, share, sb_v3_sub(to->position, from->position));
    pose.rotation = sb_quat_normalise(sb_quat_mul(from->rotation, sb_quat_from_rotation_vector(turn)));
    return pose;
}
