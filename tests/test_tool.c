/* Tests of tools: distances against searches and samples, normals against differences, skeletons, bounds and motion
 * against samples of the way, input that is refused. Tools are internal until a contact takes them. */
#define SB_SPLIT_BUILD
#include "../src/softbody/contact/tool_private.h"

#include "check.h"
#include "scene.h"
#include "skeleton.h"

/* ---- tools nobody chose ---- */

static double tool_random(unsigned long long *seed, double low, double high)
{
    return low + (high - low) * check_random(seed);
}

/* Evenly distributed over magnitudes. */
static double tool_magnitude(unsigned long long *seed, double low, double high)
{
    return low * pow(high / low, check_random(seed));
}

static sb_vec3 tool_random_vector(unsigned long long *seed, double size)
{
    double x = tool_random(seed, -size, size), y = tool_random(seed, -size, size), z = tool_random(seed, -size, size);
    return sb_v3(REAL(x), REAL(y), REAL(z));
}

static sb_vec3 tool_random_direction(unsigned long long *seed)
{
    for (;;) {
        sb_vec3 v = tool_random_vector(seed, 1);
        sb_real length = sb_v3_norm(v);
        if (length > REAL(0.1) && length < 1)
            return sb_v3_scale(1 / length, v);
    }
}

static sb_pose tool_random_pose(unsigned long long *seed, double size)
{
    sb_pose pose;
    pose.position = tool_random_vector(seed, size);
    pose.rotation =
        sb_quat_from_rotation_vector(sb_v3_scale(REAL(tool_random(seed, 0, 3.1)), tool_random_direction(seed)));
    return pose;
}

/* A tool of about this size; the def's chain lies in `points`. */
typedef struct tool_case {
    sb_tool_def def;
    sb_vec3 points[SB_TOOL_MAX_POINTS], bent[SB_TOOL_MAX_POINTS];
    double size; /* m: what lies farther off is outside */
    sbi_tool *tool;
} tool_case;

static void tool_make_chain(unsigned long long *seed, double size, int count, sb_vec3 *points)
{
    points[0] = tool_random_vector(seed, size);
    for (int i = 1; i < count; i++)
        points[i] = sb_v3_madd(points[i - 1], REAL(size * tool_random(seed, 0.01, 1)), tool_random_direction(seed));
}

static sbi_tool *tool_make(const sb_tool_def *def)
{
    sbi_tool *tool = NULL;
    sb_error error;
    if (sbi_tool_create(def, NULL, NULL, &tool, &error) != SB_OK) {
        printf("%s: %s\n", sb_result_string(error.result), error.message);
        CHECK(tool != NULL);
    }
    return tool;
}

static sb_tool_def tool_good_def(sb_tool_shape shape)
{
    static const sb_vec3 points[3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}};
    sb_tool_def def = sb_default_tool_def();
    def.shape = shape;
    def.radius = REAL(0.1);
    def.half = sb_v3(1, 1, 1);
    def.points = points;
    def.point_count = 3;
    return def;
}

static void tool_make_case(unsigned long long *seed, sb_tool_shape shape, tool_case *made)
{
    double size = tool_magnitude(seed, 1e-3, 1e3);
    sb_tool_def *def = &made->def;
    *def = sb_default_tool_def();
    def->shape = shape;
    def->radius = REAL(size * tool_magnitude(seed, 0.01, 0.5));
    made->size = 2 * size;
    if (shape == SB_TOOL_CAPSULES) {
        def->point_count = 2 + (int)(tool_random(seed, 0, 1) * tool_random(seed, 0, 1) * 62.99);
        tool_make_chain(seed, size, def->point_count, made->points);
        tool_make_chain(seed, size, def->point_count, made->bent);
        def->points = made->points;
        made->size = size * (def->point_count + 2);
    }
    if (shape == SB_TOOL_BOX) {
        double least;
        def->half = sb_v3(REAL(size * tool_random(seed, 0.05, 1)), REAL(size * tool_random(seed, 0.05, 1)),
                          REAL(size * tool_random(seed, 0.05, 1)));
        least = (double)sb_min(def->half.x, sb_min(def->half.y, def->half.z));
        def->radius = REAL(least * tool_magnitude(seed, 0.01, 1));
        if (check_random(seed) < 0.2)
            def->radius = REAL(least); /* a core without thickness */
        if (check_random(seed) < 0.2)
            def->radius = 0;
    }
    made->tool = tool_make(def);
}

static const sb_tool_shape tool_shapes[] = {SB_TOOL_SPHERE, SB_TOOL_CAPSULES, SB_TOOL_BOX, SB_TOOL_PLANE};
enum { TOOL_SHAPES = sizeof tool_shapes / sizeof tool_shapes[0] };

static const sb_vec3 tool_up = {0, 0, 1};

static sb_real tool_gap(const sbi_tool *tool, const sb_vec3 *chain, sb_vec3 x)
{
    sb_vec3 normal;
    return sbi_tool_distance(tool, chain, x, tool_up, &normal);
}

/* A point in the box around the tool, widened; some are near the surface. */
static sb_vec3 tool_random_point(unsigned long long *seed, const tool_case *c, const sb_vec3 *chain)
{
    sb_pose pose = sb_default_tool_def().pose;
    sb_vec3 low, high, x, normal;
    sb_real gap;
    sbi_tool_bounds(c->tool, chain, &pose, &low, &high);
    if (c->def.shape == SB_TOOL_PLANE)
        high = sb_v3(REAL(c->size), REAL(c->size), REAL(c->size)), low = sb_v3_scale(-1, high);
    x.x =
        REAL(tool_random(seed, 1.3 * (double)low.x - 0.3 * (double)high.x, 1.3 * (double)high.x - 0.3 * (double)low.x));
    x.y =
        REAL(tool_random(seed, 1.3 * (double)low.y - 0.3 * (double)high.y, 1.3 * (double)high.y - 0.3 * (double)low.y));
    x.z =
        REAL(tool_random(seed, 1.3 * (double)low.z - 0.3 * (double)high.z, 1.3 * (double)high.z - 0.3 * (double)low.z));
    if (check_random(seed) < 0.5)
        return x;
    gap = sbi_tool_distance(c->tool, chain, x, tool_up, &normal);
    return sb_v3_madd(x, -gap * REAL(tool_random(seed, 0.9, 1.1)), normal);
}

/* ---- distances, in another way ---- */

static double tool_far(sb_vec3 a, sb_vec3 b, double share, sb_vec3 x)
{
    double dx = (double)a.x + share * ((double)b.x - (double)a.x) - (double)x.x;
    double dy = (double)a.y + share * ((double)b.y - (double)a.y) - (double)x.y;
    double dz = (double)a.z + share * ((double)b.z - (double)a.z) - (double)x.z;
    return sqrt(dx * dx + dy * dy + dz * dz);
}

/* Distance from a segment by search: it is convex along it. */
static double tool_search_segment(sb_vec3 a, sb_vec3 b, sb_vec3 x)
{
    double low = 0, high = 1;
    for (int i = 0; i < 120; i++) {
        double third = (high - low) / 3;
        if (tool_far(a, b, low + third, x) < tool_far(a, b, high - third, x))
            high -= third;
        else
            low += third;
    }
    return fmin(tool_far(a, b, low, x), fmin(tool_far(a, b, 0, x), tool_far(a, b, 1, x)));
}

static double tool_search_chain(const sb_tool_def *def, const sb_vec3 *points, sb_vec3 x)
{
    double least = 1e300;
    for (int i = 0; i + 1 < def->point_count; i++)
        least = fmin(least, tool_search_segment(points[i], points[i + 1], x));
    return least - (double)def->radius;
}

/* Outside a convex body: the way to it is along the axes in turn, until nothing changes (alternating projections on the
 * slabs of the core end at its nearest point); inside the core: the nearest of its sides. */
static double tool_search_box(const sb_tool_def *def, sb_vec3 x)
{
    double half[3], p[3], radius = (double)def->radius, square = 0, inside = -1e300;
    half[0] = (double)def->half.x, half[1] = (double)def->half.y, half[2] = (double)def->half.z;
    if (radius == 0)
        radius = (double)(REAL(0.1) * sb_min(def->half.x, sb_min(def->half.y, def->half.z)));
    p[0] = (double)x.x, p[1] = (double)x.y, p[2] = (double)x.z;
    for (int k = 0; k < 3; k++) {
        double core = half[k] - radius, above = p[k] - core, below = -core - p[k], out = fmax(above, below);
        inside = fmax(inside, out);
        square += out > 0 ? out * out : 0;
    }
    return (square > 0 ? sqrt(square) : inside) - radius;
}

static double tool_search(const tool_case *c, const sb_vec3 *chain, sb_vec3 x)
{
    switch (c->def.shape) {
    case SB_TOOL_SPHERE: return tool_far(x, x, 0, sb_v3(0, 0, 0)) - (double)c->def.radius;
    case SB_TOOL_CAPSULES: return tool_search_chain(&c->def, chain ? chain : c->points, x);
    case SB_TOOL_BOX: return tool_search_box(&c->def, x);
    default: return (double)x.z;
    }
}

/* Runs a check on many tools of each shape. */
typedef void (*tool_check)(const tool_case *c, const sb_vec3 *chain, unsigned long long *seed);
static void tool_check_all(tool_check run, int repeats)
{
    unsigned long long seed = 11;
    for (int repeat = 0; repeat < repeats; repeat++)
        for (int i = 0; i < TOOL_SHAPES; i++) {
            tool_case c;
            tool_make_case(&seed, tool_shapes[i], &c);
            if (!c.tool)
                return;
            run(&c, NULL, &seed);
            if (c.def.shape == SB_TOOL_CAPSULES)
                run(&c, c.bent, &seed);
            sbi_tool_destroy(c.tool);
        }
}

static void check_distance(const tool_case *c, const sb_vec3 *chain, unsigned long long *seed)
{
    double worst = 0, worst_length = 0;
    for (int i = 0; i < 40; i++) {
        sb_vec3 x = tool_random_point(seed, c, chain), normal;
        sb_real gap = sbi_tool_distance(c->tool, chain, x, tool_up, &normal);
        double scale = c->size + (double)sb_v3_norm(x);
        worst = fmax(worst, fabs((double)gap - tool_search(c, chain, x)) / scale);
        worst_length = fmax(worst_length, fabs((double)sb_v3_norm(normal) - 1));
    }
    CHECK_NEAR(worst, 0, 8 * (double)SB_EPSILON);
    CHECK_NEAR(worst_length, 0, 4 * (double)SB_EPSILON);
}
static void test_distance(void) { tool_check_all(check_distance, 100); }

/* The distance of a rounded box from its surface, laid out in points. */
static void test_box_samples(void)
{
    enum { SIDE = 60 };
    unsigned long long seed = 3;
    for (int repeat = 0; repeat < 20; repeat++) {
        tool_case c;
        tool_make_case(&seed, SB_TOOL_BOX, &c);
        for (int i = 0; i < 10 && c.tool; i++) {
            sb_vec3 x = tool_random_point(&seed, &c, NULL), h = c.def.half;
            sb_real r = sbi_tool_radius(c.tool), least = SB_REAL_MAX, gap = tool_gap(c.tool, NULL, x);
            for (int j = 0; j < 6 * SIDE * SIDE; j++) { /* the sides' flat parts and what is r from the core's hull */
                int axis = j % 3, sign = j / 3 % 2;
                sb_real u = REAL(j / 6 % SIDE) / (SIDE - 1) * 2 - 1, v = REAL(j / 6 / SIDE) / (SIDE - 1) * 2 - 1;
                sb_real s = sign ? 1 : -1;
                sb_vec3 core = sb_v3(h.x - r, h.y - r, h.z - r), p, d;
                p = axis == 0   ? sb_v3(s * core.x, u * core.y, v * core.z)
                    : axis == 1 ? sb_v3(u * core.x, s * core.y, v * core.z)
                                : sb_v3(u * core.x, v * core.y, s * core.z);
                if (gap > -r)
                    d = sb_v3_sub(x, p);
                else
                    d = sb_v3_sub(x, axis == 0   ? sb_v3(s * h.x, p.y, p.z)
                                     : axis == 1 ? sb_v3(p.x, s * h.y, p.z)
                                                 : sb_v3(p.x, p.y, s * h.z));
                least = sb_min(least, sb_v3_norm(d));
            }
            CHECK_NEAR(gap > -r ? least - r : -least, gap, 0.03 * (double)sb_v3_norm(h));
        }
        sbi_tool_destroy(c.tool);
    }
}

/* Differences of the distance along each axis are the normal, but where the nearest part of the skeleton changes. */
static void check_gradient(const tool_case *c, const sb_vec3 *chain, unsigned long long *seed)
{
    int compared = 0, count = 40;
    for (int i = 0; i < count; i++) {
        sb_vec3 x = tool_random_point(seed, c, chain), normal, step[3];
        sb_real gap = sbi_tool_distance(c->tool, chain, x, tool_up, &normal), worst = 0, bend = 0;
        sb_real size = sb_max(sb_abs(gap + sb_min(sbi_tool_radius(c->tool), REAL(c->size))), REAL(0.001 * c->size));
        sb_real h = REAL(sqrt((double)SB_EPSILON)) * size * 10;
        step[0] = sb_v3(h, 0, 0), step[1] = sb_v3(0, h, 0), step[2] = sb_v3(0, 0, h);
        for (int k = 0; k < 3; k++) {
            sb_real above = tool_gap(c->tool, chain, sb_v3_add(x, step[k]));
            sb_real below = tool_gap(c->tool, chain, sb_v3_sub(x, step[k]));
            sb_real n = k == 0 ? normal.x : k == 1 ? normal.y : normal.z;
            worst = sb_max(worst, sb_abs((above - below) / (2 * h) - n));
            bend = sb_max(bend, sb_abs(above - 2 * gap + below) / h);
        }
        if (bend > REAL(1e-2))
            continue;
        compared++;
        CHECK_NEAR(worst, 0, 1e-2 + 1e-6 * c->size / (double)size);
    }
    CHECK(compared > count / 2);
}
static void test_gradient(void) { tool_check_all(check_gradient, 100); }

static void check_lipschitz(const tool_case *c, const sb_vec3 *chain, unsigned long long *seed)
{
    double worst = 0;
    for (int i = 0; i < 40; i++) {
        sb_vec3 x = tool_random_point(seed, c, chain), y = tool_random_point(seed, c, chain);
        double far, rounding = 8 * (double)SB_EPSILON * (c->size + (double)sb_v3_norm(x) + (double)sb_v3_norm(y));
        if (i % 2)
            y = sb_v3_madd(x, REAL(1e-3), sb_v3_sub(y, x));
        far = (double)sb_v3_norm(sb_v3_sub(x, y));
        worst = fmax(worst, (fabs((double)tool_gap(c->tool, chain, x) - (double)tool_gap(c->tool, chain, y)) - far) /
                                rounding);
    }
    CHECK(worst <= 1);
}
static void test_lipschitz(void) { tool_check_all(check_lipschitz, 100); }

/* Many at once are each as alone. */
static void check_batch(const tool_case *c, const sb_vec3 *chain, unsigned long long *seed)
{
    enum { COUNT = 37 };
    sb_vec3 x[COUNT], fallback[COUNT], normal[COUNT];
    sb_real gap[COUNT];
    for (int i = 0; i < COUNT; i++) {
        x[i] = i % 5 ? tool_random_point(seed, c, chain) : chain ? chain[1] : sb_v3(0, 0, 0);
        fallback[i] = normal[i] = tool_random_direction(seed);
    }
    sbi_tool_distances(c->tool, chain, COUNT, x, normal, gap, normal); /* in place */
    for (int i = 0; i < COUNT; i++) {
        sb_vec3 alone;
        CHECK(sbi_tool_distance(c->tool, chain, x[i], fallback[i], &alone) == gap[i]);
        CHECK(alone.x == normal[i].x && alone.y == normal[i].y && alone.z == normal[i].z);
    }
}
static void test_batch(void) { tool_check_all(check_batch, 50); }

/* ---- where there is no gradient, and points that are no points ---- */

static int tool_is_same(sb_vec3 a, sb_vec3 b) { return a.x == b.x && a.y == b.y && a.z == b.z; }

static void check_skeleton(const tool_case *c, const sb_vec3 *chain, unsigned long long *seed)
{
    sb_vec3 points[SBI_TOOL_MAX_SKELETON], normal, fallback = tool_random_direction(seed);
    int ends[SB_TOOL_MAX_POINTS][2], count, segments, none;
    double rounding = 8 * (double)SB_EPSILON * c->size;
    count = sbi_tool_skeleton(c->tool, chain, points, SBI_TOOL_MAX_SKELETON);
    segments = sbi_tool_segments(c->tool, ends, SB_TOOL_MAX_POINTS);
    none = sbi_tool_skeleton(c->tool, chain, NULL, 0);
    CHECK_INT(none, count);
    CHECK_INT(sbi_tool_segments(c->tool, NULL, 0), segments);
    for (int i = 0; i < count; i++) {
        sb_real gap = sbi_tool_distance(c->tool, chain, points[i], fallback, &normal);
        CHECK((double)gap <= -(double)sbi_tool_inner_radius(c->tool) + rounding);
        CHECK_NEAR(sb_v3_norm(normal), 1, 4 * (double)SB_EPSILON);
        if (c->def.shape != SB_TOOL_BOX && !chain)
            CHECK(tool_is_same(normal, fallback));
    }
    for (int i = 0; i < 40 && segments > 0; i++) {
        const int *end = ends[i % segments];
        sb_real share = REAL(check_random(seed));
        sb_vec3 x = sb_v3_madd(points[end[0]], share, sb_v3_sub(points[end[1]], points[end[0]]));
        CHECK((double)tool_gap(c->tool, chain, x) <= -(double)sbi_tool_inner_radius(c->tool) + rounding);
    }
}
static void test_skeleton(void) { tool_check_all(check_skeleton, 100); }

static void check_absurd_points(const tool_case *c, const sb_vec3 *chain, unsigned long long *seed)
{
    const sb_real numbers[] = {REAL(NAN),
                               REAL(INFINITY),
                               REAL(-INFINITY),
                               SB_REAL_MAX,
                               -SB_REAL_MAX,
                               REAL(1e30),
                               REAL(1e-37),
                               REAL(-1e-37),
                               REAL(1e19) * c->def.radius,
                               0};
    const int count = (int)(sizeof numbers / sizeof numbers[0]);
    sb_vec3 fallback = tool_random_direction(seed);
    for (int i = 0; i < count * count * count; i++) {
        sb_vec3 x = sb_v3(numbers[i % count], numbers[i / count % count], numbers[i / count / count]), normal;
        sb_real gap = sbi_tool_distance(c->tool, chain, x, fallback, &normal);
        CHECK(sb_is_finite(gap));
        CHECK_NEAR(sb_v3_norm(normal), 1, 4 * (double)SB_EPSILON);
        if (!sb_v3_is_finite(x))
            CHECK(gap == SB_REAL_MAX && tool_is_same(normal, fallback));
    }
}
static void test_absurd_points(void)
{
    check_bad_numbers();
    tool_check_all(check_absurd_points, 3);
}

/* Inside a box's core: at its middle the fallback, elsewhere out of the nearest side. */
static void test_box_core(void)
{
    sb_tool_def def = sb_default_tool_def();
    sbi_tool *tool;
    sb_vec3 normal;
    def.shape = SB_TOOL_BOX;
    def.half = sb_v3(1, 2, 3);
    def.radius = REAL(0.25);
    tool = tool_make(&def);
    CHECK_NEAR(sbi_tool_distance(tool, NULL, sb_v3(0, 0, 0), tool_up, &normal), -1, 0);
    CHECK(tool_is_same(normal, tool_up));
    CHECK_NEAR(sbi_tool_distance(tool, NULL, sb_v3(REAL(-0.5), 0, 0), tool_up, &normal), -0.5, 0);
    CHECK(tool_is_same(normal, sb_v3(-1, 0, 0)));
    CHECK_NEAR(sbi_tool_distance(tool, NULL, sb_v3(0, REAL(1.5), 2), tool_up, &normal), -0.5, 0);
    CHECK(tool_is_same(normal, sb_v3(0, 1, 0)));
    CHECK_NEAR(sbi_tool_distance(tool, NULL, sb_v3(REAL(0.1), 0, REAL(-2.5)), tool_up, &normal), -0.5, 0);
    CHECK(tool_is_same(normal, sb_v3(0, 0, -1)));
    CHECK_NEAR(sbi_tool_inner_radius(tool), 0.25, 0);
    sbi_tool_destroy(tool);
}

/* ---- poses ---- */

static void test_poses(void)
{
    unsigned long long seed = 5;
    for (int i = 0; i < 300; i++) {
        double size = tool_magnitude(&seed, 1e-3, 1e3);
        sb_pose from = tool_random_pose(&seed, size), to = tool_random_pose(&seed, size), half, there;
        sb_vec3 x = tool_random_vector(&seed, size), turn = sbi_pose_rotation(&from, &to), rest;
        sb_real share = REAL(check_random(&seed));
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(sbi_pose_to_tool(&from, sbi_pose_to_space(&from, x)), x)), 0,
                   16 * (double)SB_EPSILON * size);
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(sbi_pose_turn_to_tool(&from, sbi_pose_turn_to_space(&from, x)), x)), 0,
                   16 * (double)SB_EPSILON * size);
        there = sbi_pose_between(&from, &to, 0);
        CHECK(memcmp(&there, &from, sizeof from) == 0);
        there = sbi_pose_between(&from, &to, 1);
        CHECK(memcmp(&there, &to, sizeof to) == 0);
        half = sbi_pose_between(&from, &to, share);
        CHECK_NEAR(sqrt((double)sb_quat_dot(half.rotation, half.rotation)), 1, 4 * (double)SB_EPSILON);
        CHECK((double)sb_v3_norm(turn) <= 3.1415926535897935 * (1 + (double)SB_EPSILON));
        rest = sbi_pose_rotation(&half, &to); /* even speed about one axis */
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(sb_v3_scale(1 - share, turn), rest)), 0, 1e2 * (double)SB_EPSILON);
        to.rotation = sb_quat_make(-to.rotation.w, -to.rotation.x, -to.rotation.y, -to.rotation.z);
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(sbi_pose_rotation(&from, &to), turn)), 0, 32 * (double)SB_EPSILON);
    }
}

static void test_pose_check(void)
{
    sb_pose pose = sb_default_tool_def().pose, unit;
    sb_error error;
    check_bad_numbers();
    pose.rotation = sb_quat_make(0, 0, -3, 4);
    CHECK_OK(sbi_tool_pose_check(&pose, "pose", &unit, &error));
    CHECK_NEAR(unit.rotation.y, -0.6, 4 * (double)SB_EPSILON);
    CHECK_NEAR(unit.rotation.z, 0.8, 4 * (double)SB_EPSILON);
    pose.rotation = sb_quat_make(0, SB_REAL_MAX, 0, 0);
    CHECK_OK(sbi_tool_pose_check(&pose, "pose", &unit, &error));
    CHECK_NEAR(unit.rotation.x, 1, 0);
    CHECK_RESULT(sbi_tool_pose_check(NULL, "pose", &unit, &error), SB_ERROR_ARGUMENT);
    pose.rotation = sb_quat_make(0, 0, 0, 0);
    CHECK_RESULT(sbi_tool_pose_check(&pose, "pose", &unit, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "pose.rotation") != NULL);
    pose.rotation = sb_quat_make(1, 0, REAL(NAN), 0);
    CHECK_RESULT(sbi_tool_pose_check(&pose, "pose", &unit, &error), SB_ERROR_NOT_FINITE);
    pose.rotation = sb_quat_identity();
    pose.position.y = REAL(INFINITY);
    CHECK_RESULT(sbi_tool_pose_check(&pose, "pose", NULL, NULL), SB_ERROR_NOT_FINITE);
}

/* A tool that stands elsewhere is that tool: a chain moved by hand has the distances of the chain seen from there. */
static void test_chain_moved(void)
{
    unsigned long long seed = 17;
    for (int repeat = 0; repeat < 100; repeat++) {
        tool_case c;
        sb_pose pose;
        sb_vec3 x, normal, moved_normal;
        sb_real gap, moved_gap;
        tool_make_case(&seed, SB_TOOL_CAPSULES, &c);
        pose = tool_random_pose(&seed, c.size);
        for (int i = 0; i < c.def.point_count; i++)
            c.bent[i] = sbi_pose_to_space(&pose, c.points[i]);
        x = tool_random_point(&seed, &c, NULL);
        gap = sbi_tool_distance(c.tool, NULL, x, tool_up, &normal);
        moved_gap = sbi_tool_distance(c.tool, c.bent, sbi_pose_to_space(&pose, x), tool_up, &moved_normal);
        CHECK_NEAR(moved_gap, gap, 32 * (double)SB_EPSILON * c.size);
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(moved_normal, sbi_pose_turn_to_space(&pose, normal))), 0,
                   64 * (double)SB_EPSILON * c.size / (double)sb_abs(gap + c.def.radius));
        sbi_tool_destroy(c.tool);
    }
}

static void check_bounds(const tool_case *c, const sb_vec3 *chain, unsigned long long *seed)
{
    sb_pose pose = tool_random_pose(seed, c->size);
    sb_vec3 low, high;
    sbi_tool_bounds(c->tool, chain, &pose, &low, &high);
    CHECK(low.x < high.x && low.y < high.y && low.z < high.z);
    for (int i = 0; i < 60; i++) {
        sb_vec3 x = tool_random_point(seed, c, chain);
        if (i % 4 == 0) /* a point of its surface: from the skeleton outward */
            for (int k = 0; k < 4; k++) {
                sb_vec3 normal;
                sb_real gap = sbi_tool_distance(c->tool, chain, x, tool_up, &normal);
                x = sb_v3_madd(x, -gap, normal);
            }
        if (tool_gap(c->tool, chain, x) > REAL(1e-9) * REAL(c->size))
            continue;
        x = sbi_pose_to_space(&pose, x);
        CHECK(x.x >= low.x - REAL(1e-8 * c->size) && x.x <= high.x + REAL(1e-8 * c->size));
        CHECK(x.y >= low.y - REAL(1e-8 * c->size) && x.y <= high.y + REAL(1e-8 * c->size));
        CHECK(x.z >= low.z - REAL(1e-8 * c->size) && x.z <= high.z + REAL(1e-8 * c->size));
    }
    if (c->def.shape == SB_TOOL_SPHERE)
        CHECK_NEAR(high.y - low.y, 2 * c->def.radius, 1e2 * (double)SB_EPSILON * (2 * c->size));
    if (c->def.shape == SB_TOOL_PLANE)
        CHECK(low.x == -SB_REAL_MAX && high.z == SB_REAL_MAX);
}
static void test_bounds(void) { tool_check_all(check_bounds, 100); }

/* No point of the skeleton moves farther than the bound says, nor in a part of the way than its share. */
static void check_motion(const tool_case *c, const sb_vec3 *chain, unsigned long long *seed)
{
    static const double angles[] = {0, 1e-3, 0.3, 3.1};
    const sb_vec3 *chain0 = c->def.shape == SB_TOOL_CAPSULES ? c->points : NULL, *chain1 = chain ? chain : chain0;
    for (int i = 0; i < 4; i++) {
        double scale = angles[i] == 0 ? 1 : tool_magnitude(seed, 1e-3, 1);
        sb_pose from = tool_random_pose(seed, c->size), to = from, at, before = from;
        sb_vec3 now[SBI_TOOL_MAX_SKELETON], last[SBI_TOOL_MAX_SKELETON], first[SBI_TOOL_MAX_SKELETON];
        int count = sbi_tool_skeleton(c->tool, chain0, first, SBI_TOOL_MAX_SKELETON);
        double bound, most = 0, rounding = 32 * (double)SB_EPSILON * (4 * c->size);
        to.position = sb_v3_add(to.position, tool_random_vector(seed, c->size * scale));
        to.rotation = sb_quat_normalise(sb_quat_mul(
            sb_quat_from_rotation_vector(sb_v3_scale(REAL(angles[i]), tool_random_direction(seed))), to.rotation));
        bound = (double)sbi_tool_motion(c->tool, chain0, &from, chain1, &to);
        memcpy(last, first, sizeof last);
        for (int k = 1; k <= 50; k++) {
            double share = k / 50.0;
            at = sbi_pose_between(&from, &to, REAL(share));
            for (int p = 0; p < count; p++) {
                double moved, part;
                now[p] = chain0 ? sb_v3_madd(first[p], REAL(share), sb_v3_sub(chain1[p], first[p])) : first[p];
                moved =
                    (double)sb_v3_norm(sb_v3_sub(sbi_pose_to_space(&at, now[p]), sbi_pose_to_space(&from, first[p])));
                part =
                    (double)sb_v3_norm(sb_v3_sub(sbi_pose_to_space(&at, now[p]), sbi_pose_to_space(&before, last[p])));
                CHECK(moved <= share * bound + rounding);
                CHECK(part <= bound / 50 + rounding);
                most = fmax(most, moved);
            }
            memcpy(last, now, sizeof last);
            before = at;
        }
        CHECK(bound <= (angles[i] < 0.01 ? 1.01 : 8) * most + rounding || chain || c->def.shape == SB_TOOL_MESH);
        if (c->def.shape == SB_TOOL_PLANE)
            CHECK(bound == 0);
    }
}
static void test_motion(void) { tool_check_all(check_motion, 30); }

/* ---- meshes ---- */

/* A closed surface round the z axis, as wide as profile[rings] (> 0) says at even heights from -length/2 to length/2,
 * with a point at each end; turned about by `pose`. */
static sb_mesh tool_revolve(const double *profile, int rings, int around, double length, const sb_pose *pose)
{
    sb_mesh mesh;
    int *corner;
    memset(&mesh, 0, sizeof mesh);
    if (!CHECK(sbi_mesh_allocate(&mesh, SB_TRI3, rings * around + 2, 2 * around * rings, 0, NULL)))
        return mesh;
    corner = mesh.elements;
    for (int r = 0; r < rings; r++)
        for (int k = 0; k < around; k++) {
            double angle = 2 * 3.14159265358979323846 * (k + 0.5 * (r % 2)) / around;
            mesh.nodes[r * around + k] = sb_v3(REAL(profile[r] * cos(angle)), REAL(profile[r] * sin(angle)),
                                               REAL(length * ((r + 1.0) / (rings + 1) - 0.5)));
        }
    mesh.nodes[rings * around] = sb_v3(0, 0, REAL(-0.5 * length));
    mesh.nodes[rings * around + 1] = sb_v3(0, 0, REAL(0.5 * length));
    for (int k = 0; k < around; k++) {
        int next = (k + 1) % around, top = (rings - 1) * around;
        *corner++ = rings * around, *corner++ = next, *corner++ = k;
        *corner++ = rings * around + 1, *corner++ = top + k, *corner++ = top + next;
        for (int r = 0; r + 1 < rings; r++) {
            int a = r * around + k, b = r * around + next, c = a + around, d = b + around;
            *corner++ = a, *corner++ = b, *corner++ = d;
            *corner++ = a, *corner++ = d, *corner++ = c;
        }
    }
    for (int i = 0; i < mesh.node_count; i++)
        mesh.nodes[i] = sbi_pose_to_space(pose, mesh.nodes[i]);
    return mesh;
}

enum { TOOL_RINGS = 20 };

/* A mesh tool: an ellipsoid for kind 0, a dumbbell for 1, else something lumpy. */
typedef struct tool_mesh_case {
    tool_case base;
    sb_mesh mesh;
    sb_surface *surface;
    double length, cell;
} tool_mesh_case;

static int tool_make_mesh_case(unsigned long long *seed, int kind, int cells, tool_mesh_case *made)
{
    double profile[TOOL_RINGS], length = tool_magnitude(seed, 1e-3, 1e3), waves = tool_random(seed, 0, 8);
    sb_pose pose = tool_random_pose(seed, 0.5 * length);
    sb_vec3 low, high;
    for (int r = 0; r < TOOL_RINGS; r++) {
        double z = 2 * (r + 1.0) / (TOOL_RINGS + 1) - 1, round = sqrt(1 - z * z);
        profile[r] = length * (kind == 0   ? 0.3 * round
                               : kind == 1 ? (fabs(z) > 0.6 ? 0.3 : 0.08)
                                           : 0.3 * round * (1 + 0.2 * sin(waves * z)));
    }
    memset(made, 0, sizeof *made);
    made->mesh = tool_revolve(profile, TOOL_RINGS, 24, length, &pose);
    made->length = length;
    made->base.size = 2 * length;
    made->base.def = sb_default_tool_def();
    made->base.def.shape = SB_TOOL_MESH;
    made->base.def.surface = &made->mesh;
    made->base.def.cells = cells;
    made->base.tool = tool_make(&made->base.def);
    sb_mesh_bounds(&made->mesh, &low, &high);
    low = sb_v3_sub(high, low);
    made->cell = (double)sb_max(low.x, sb_max(low.y, low.z)) / cells;
    return CHECK_OK(sb_surface_create(&made->mesh, NULL, &made->surface, NULL)) && made->base.tool;
}

static void tool_free_mesh_case(tool_mesh_case *made)
{
    sbi_tool_destroy(made->base.tool);
    sb_surface_destroy(made->surface);
    sb_mesh_free(&made->mesh);
}

/* Near the surface the function is the distance to a part of a cell, and its normal that of the surface, smoothed. */
static void test_mesh_distance(void)
{
    unsigned long long seed = 23;
    for (int repeat = 0; repeat < 4; repeat++) {
        tool_mesh_case c;
        double worst = 0, sum = 0, turned = 1, steepest = 0;
        const int count = 400;
        if (!tool_make_mesh_case(&seed, repeat % 2 ? 2 : 0, repeat < 2 ? 24 : 48, &c))
            return;
        for (int i = 0; i < count; i++) {
            sb_vec3 x = tool_random_point(&seed, &c.base, NULL), normal, y;
            sb_surface_hit hit;
            sb_real gap, exact;
            sb_surface_closest(c.surface, x, SB_REAL_MAX, &hit);
            x = sb_v3_madd(hit.point, REAL(c.cell * tool_random(&seed, -2, 2)), sb_surface_normal(c.surface, &hit));
            exact = sb_surface_signed_distance(c.surface, x, &hit);
            gap = sbi_tool_distance(c.base.tool, NULL, x, tool_up, &normal);
            worst = fmax(worst, fabs((double)gap - (double)exact) / c.cell);
            sum += fabs((double)gap - (double)exact) / c.cell;
            turned = fmin(turned, (double)sb_v3_dot(normal, sb_surface_normal(c.surface, &hit)));
            CHECK_NEAR(sb_v3_norm(normal), 1, 4 * (double)SB_EPSILON);
            y = sb_v3_madd(x, REAL(c.cell * tool_random(&seed, 0.01, 1)), tool_random_direction(&seed));
            steepest = fmax(steepest, fabs((double)tool_gap(c.base.tool, NULL, y) - (double)gap) /
                                          (double)sb_v3_norm(sb_v3_sub(x, y)));
        }
        CHECK(worst < 0.25 && sum / count < 0.03 && turned > 0.5);
        CHECK(steepest < 1.1);
        tool_free_mesh_case(&c);
    }
}

/* The normal has the direction of the gradient, and neither it nor the distance jumps where cells meet. */
static void test_mesh_smooth(void)
{
    unsigned long long seed = 29;
    double step = SB_REAL_IS_FLOAT ? 1e-2 : 1e-5;
    for (int repeat = 0; repeat < 6; repeat++) {
        tool_mesh_case c;
        const sbi_tool_grid *grid;
        if (!tool_make_mesh_case(&seed, repeat % 3, 24, &c))
            return;
        grid = &c.base.tool->grid;
        for (int i = 0; i < 400; i++) {
            double h = step * c.cell;
            sb_vec3 x, normal, difference = sb_v3(0, 0, 0), d[3];
            int axis = i % 3, node[3];
            for (int k = 0; k < 3; k++)
                node[k] = 2 + (int)(check_random(&seed) * (grid->counts[k] - 5.01));
            x = sb_v3_madd(grid->low, grid->cell, sb_v3(REAL(node[0]), REAL(node[1]), REAL(node[2])));
            d[0] = sb_v3(1, 0, 0), d[1] = sb_v3(0, 1, 0), d[2] = sb_v3(0, 0, 1);
            for (int k = 0; k < 3; k++) /* somewhere on a side between cells */
                if (k != axis)
                    x = sb_v3_madd(x, REAL(check_random(&seed)) * grid->cell, d[k]);
            sbi_tool_distance(c.base.tool, NULL, x, tool_up, &normal);
            for (int k = 0; k < 3; k++) {
                sb_vec3 a = sb_v3_madd(x, REAL(h), d[k]), b = sb_v3_madd(x, REAL(-h), d[k]), na, nb;
                sb_real above = sbi_tool_distance(c.base.tool, NULL, a, tool_up, &na);
                sb_real below = sbi_tool_distance(c.base.tool, NULL, b, tool_up, &nb);
                difference = sb_v3_madd(difference, (above - below) / REAL(2 * h), d[k]);
                CHECK_NEAR(above, below, 2.6 * h);
            }
            if (sb_v3_norm(difference) < REAL(0.3)) /* near the middle */
                continue;
            CHECK_NEAR(sb_v3_norm(sb_v3_sub(sb_v3_scale(1 / sb_v3_norm(difference), difference), normal)), 0,
                       SB_REAL_IS_FLOAT ? 0.05 : 1e-3);
            for (int k = 0; k < 3; k++) {
                sb_vec3 na, nb;
                sbi_tool_distance(c.base.tool, NULL, sb_v3_madd(x, REAL(h), d[k]), tool_up, &na);
                sbi_tool_distance(c.base.tool, NULL, sb_v3_madd(x, REAL(-h), d[k]), tool_up, &nb);
                CHECK_NEAR(sb_v3_norm(sb_v3_sub(na, nb)), 0, 30 * step);
            }
        }
        tool_free_mesh_case(&c);
    }
}

/* Beyond the grid: a lower bound of the distance, not a bad one, that starts where the grid ends, with a normal that
 * points away from the tool. */
static void test_mesh_beyond(void)
{
    unsigned long long seed = 31;
    for (int repeat = 0; repeat < 6; repeat++) {
        tool_mesh_case c;
        double nearest = 1, turned = 1, above = 0;
        if (!tool_make_mesh_case(&seed, repeat % 3, 24, &c))
            return;
        for (int i = 0; i < 500; i++) {
            const sbi_tool_grid *grid = &c.base.tool->grid;
            sb_vec3 middle = sb_v3_scale(REAL(0.5), sb_v3_add(grid->surface_low, grid->surface_high)), normal, x, y;
            double far = c.length * tool_magnitude(&seed, 0.1, 100);
            sb_real gap, exact, other;
            sb_surface_hit hit;
            x = sb_v3_madd(middle, REAL(far), tool_random_direction(&seed));
            exact = sb_surface_signed_distance(c.surface, x, &hit);
            if ((double)exact < 0.1 * c.cell)
                continue;
            gap = sbi_tool_distance(c.base.tool, NULL, x, tool_up, &normal);
            above = fmax(above, ((double)gap - (double)exact) / c.cell - 1e2 * (double)SB_EPSILON * far / c.cell);
            if (exact > 2 * REAL(c.cell))
                nearest = fmin(nearest, (double)gap / (double)exact);
            turned = fmin(turned, (double)sb_v3_dot(normal, sb_v3_sub(x, hit.point)) / (double)exact);
            y = sb_v3_madd(x, REAL(c.cell * tool_random(&seed, 1e-6, 1)), tool_random_direction(&seed));
            other = tool_gap(c.base.tool, NULL, y);
            CHECK_NEAR(other, gap, 1.3 * (double)sb_v3_norm(sb_v3_sub(x, y)) + 1e2 * (double)SB_EPSILON * far);
        }
        CHECK(above < 0.2 && nearest > 0.6 && turned > 0.6);
        tool_free_mesh_case(&c);
    }
}

/* The skeleton lies as deep as is said, truly too; a thin shaft between thick ends has its part of it. */
static void test_mesh_skeleton(void)
{
    unsigned long long seed = 37;
    for (int repeat = 0; repeat < 6; repeat++) {
        tool_mesh_case c;
        sb_vec3 points[SBI_TOOL_MAX_SKELETON], low, high, x;
        double inner, length;
        int count;
        if (!tool_make_mesh_case(&seed, repeat % 3, 28, &c))
            return;
        inner = (double)sbi_tool_inner_radius(c.base.tool);
        count = sbi_tool_skeleton(c.base.tool, NULL, points, SBI_TOOL_MAX_SKELETON);
        CHECK(count > 0 && count <= SBI_TOOL_MAX_SKELETON && sbi_tool_skeleton(c.base.tool, NULL, NULL, 0) == count);
        low = high = points[0];
        for (int i = 0; i < count; i++) {
            x = points[i];
            CHECK(-(double)sb_surface_signed_distance(c.surface, x, NULL) >= inner - 1e-6 * c.length);
            CHECK(-(double)tool_gap(c.base.tool, NULL, x) >= inner - 1e-6 * c.length);
            low = sb_v3(sb_min(low.x, x.x), sb_min(low.y, x.y), sb_min(low.z, x.z));
            high = sb_v3(sb_max(high.x, x.x), sb_max(high.y, x.y), sb_max(high.z, x.z));
        }
        length = (double)sb_v3_norm(sb_v3_sub(high, low)) + 4 * inner;
        if (repeat % 3 == 1)
            CHECK(inner < 0.08 * c.length && length > 0.8 * c.length);
        else
            CHECK(inner > 0.1 * c.length && length > 0.5 * c.length);
        CHECK_INT(sbi_tool_segments(c.base.tool, NULL, 0), 0);
        CHECK_NEAR(sbi_tool_radius(c.base.tool), fmin(inner, 2 * c.cell), 1e-6 * c.length);
        tool_free_mesh_case(&c);
    }
}

/* What holds for the other shapes holds for meshes. */
static void test_mesh_common(void)
{
    unsigned long long seed = 41;
    for (int repeat = 0; repeat < 6; repeat++) {
        tool_mesh_case c;
        if (!tool_make_mesh_case(&seed, repeat % 3, 16 + 3 * repeat, &c))
            return;
        check_batch(&c.base, NULL, &seed);
        check_bounds(&c.base, NULL, &seed);
        check_motion(&c.base, NULL, &seed);
        tool_free_mesh_case(&c);
    }
}

static void test_mesh_absurd_points(void)
{
    unsigned long long seed = 43;
    tool_mesh_case c;
    check_bad_numbers();
    if (!tool_make_mesh_case(&seed, 2, 16, &c))
        return;
    check_absurd_points(&c.base, NULL, &seed);
    tool_free_mesh_case(&c);
}

/* In the middle of a cube, where all sides are equally near, the fallback. */
static void test_mesh_middle(void)
{
    sb_mesh box = scene_box(SB_TET4, 2, 2, 2, sb_v3(2, 2, 2), 0);
    sb_tool_def def = sb_default_tool_def();
    sb_boundary boundary;
    sb_vec3 normal;
    sbi_tool *tool;
    if (!CHECK_OK(sb_mesh_boundary(&box, 1, NULL, &boundary, NULL)))
        return;
    def.shape = SB_TOOL_MESH;
    def.surface = &boundary.surface;
    tool = tool_make(&def);
    sbi_tool_distance(tool, NULL, sb_v3(1, 1, 1), tool_up, &normal);
    CHECK(tool_is_same(normal, tool_up));
    CHECK_NEAR(sbi_tool_distance(tool, NULL, sb_v3(REAL(0.25), 1, REAL(1.1)), tool_up, &normal), -0.25, 1e-6);
    CHECK_NEAR(normal.x, -1, 1e-5);
    sbi_tool_destroy(tool);
    sb_boundary_free(&boundary);
    sb_mesh_free(&box);
}

static void tool_run_backwards(void *user, sb_task task, void *task_user, int count)
{
    (void)user;
    for (int i = count; i-- > 0;)
        task(task_user, i);
}

static void test_mesh_threads(void)
{
    unsigned long long seed = 47;
    tool_mesh_case c;
    sb_jobs jobs = {tool_run_backwards, NULL};
    sbi_tool *other = NULL;
    if (!tool_make_mesh_case(&seed, 2, 20, &c))
        return;
    CHECK_OK(sbi_tool_create(&c.base.def, NULL, &jobs, &other, NULL));
    CHECK(other && memcmp(other->grid.distances, c.base.tool->grid.distances,
                          sizeof(float) * sbi_tool_grid_node_count(&other->grid)) == 0);
    sbi_tool_destroy(other);
    tool_free_mesh_case(&c);
}

/* ---- the test whether a skeleton crosses a triangle ---- */

/* Sides of planes through points of a fine lattice, which are hardly off the plane or not at all, against integers. */
static void test_crossing_side(void)
{
    unsigned long long seed = 61;
    int zeros = 0;
    for (int i = 0; i < 20000; i++) {
        long long x[4][3], d[3][3], det;
        double p[4][3];
        int m = (int)tool_random(&seed, -4, 5), n = (int)tool_random(&seed, -4, 5), side;
        for (int r = 0; r < 3; r++)
            for (int k = 0; k < 3; k++)
                x[r][k] = (long long)tool_random(&seed, -100000, 100000);
        for (int k = 0; k < 3; k++) /* in the plane, and then off by a step or not */
            x[3][k] = x[0][k] + m * (x[1][k] - x[0][k]) + n * (x[2][k] - x[0][k]);
        x[3][i % 3] += (int)tool_random(&seed, -1, 2);
        for (int r = 0; r < 3; r++)
            for (int k = 0; k < 3; k++)
                d[r][k] = x[r][k] - x[3][k];
        det = d[0][0] * (d[1][1] * d[2][2] - d[1][2] * d[2][1]) + d[0][1] * (d[1][2] * d[2][0] - d[1][0] * d[2][2]) +
              d[0][2] * (d[1][0] * d[2][1] - d[1][1] * d[2][0]);
        for (int r = 0; r < 4; r++)
            for (int k = 0; k < 3; k++)
                p[r][k] = (double)x[r][k] / 4096 + 1024; /* exact */
        side = skeleton_side(p[0], p[1], p[2], p[3]);
        CHECK_INT(side, det > 0 ? 1 : det < 0 ? -1 : 0);
        zeros += det == 0;
    }
    CHECK(zeros > 100 && zeros < 20000);
}

/* A triangle that holds the point x well inside of it. */
static void tool_triangle_round(unsigned long long *seed, sb_vec3 x, double size, sb_vec3 triangle[3])
{
    sb_vec3 a = sb_v3_scale(REAL(size), tool_random_direction(seed));
    sb_vec3 b = sb_v3_scale(REAL(size), tool_random_direction(seed));
    triangle[0] = sb_v3_add(x, a);
    triangle[1] = sb_v3_add(x, b);
    triangle[2] = sb_v3_sub(x, sb_v3_scale(REAL(tool_random(seed, 0.5, 1)), sb_v3_add(a, b)));
}

/* The least depth at which points of a triangle lie about a skeleton. */
static double tool_deepest(const sbi_tool *tool, const sb_pose *pose, const sb_vec3 triangle[3], int parts)
{
    double deepest = 1e300;
    for (int i = 0; i <= parts; i++)
        for (int j = 0; i + j <= parts; j++) {
            sb_vec3 u = sb_v3_sub(triangle[1], triangle[0]), v = sb_v3_sub(triangle[2], triangle[0]), x = triangle[0];
            x = sb_v3_madd(sb_v3_madd(x, REAL(i) / REAL(parts), u), REAL(j) / REAL(parts), v);
            deepest = fmin(deepest, (double)tool_gap(tool, NULL, sbi_pose_to_tool(pose, x)));
        }
    return deepest;
}

static void check_crossing(const tool_case *c, const sb_vec3 *chain, unsigned long long *seed)
{
    enum { PARTS = 40 };
    sb_pose pose = tool_random_pose(seed, c->size);
    sb_vec3 points[SBI_TOOL_MAX_SKELETON], triangle[3], x;
    int ends[SB_TOOL_MAX_POINTS][2], segments = sbi_tool_segments(c->tool, ends, SB_TOOL_MAX_POINTS);
    int crossed = 0, count = 20;
    sbi_tool_skeleton(c->tool, NULL, points, SBI_TOOL_MAX_SKELETON);
    if (segments == 0 || chain || (c->def.shape == SB_TOOL_BOX && sb_v3_norm(points[7]) == 0))
        return;
    for (int i = 0; i < count; i++) {
        const int *end = ends[i % segments];
        double size = c->size * tool_random(seed, 0.01, 0.1);
        sb_vec3 way = sb_v3_sub(points[end[1]], points[end[0]]);
        x = sb_v3_madd(points[end[0]], REAL(tool_random(seed, 0.1, 0.9)), way);
        if (c->def.shape == SB_TOOL_BOX) /* a plane through an edge may only touch */
            x = sb_v3_scale(REAL(0.9), x);
        tool_triangle_round(seed, sbi_pose_to_space(&pose, x), size, triangle);
        crossed += skeleton_meets(c->tool, NULL, &pose, triangle);
        x = sb_v3_madd(x, REAL(c->size * tool_random(seed, 0, 0.5)), tool_random_direction(seed));
        tool_triangle_round(seed, sbi_pose_to_space(&pose, x), size, triangle);
        if (skeleton_meets(c->tool, NULL, &pose, triangle))
            CHECK(tool_deepest(c->tool, &pose, triangle, PARTS) <=
                  -(double)sbi_tool_inner_radius(c->tool) + 4 * size / (double)PARTS);
        else if (c->def.shape == SB_TOOL_BOX)
            CHECK(tool_deepest(c->tool, &pose, triangle, PARTS) >=
                  -(double)sbi_tool_inner_radius(c->tool) - 1e-5 * size);
    }
    CHECK(crossed >= count - 2); /* but for triangles all but along the segment */
}
static void test_crossing(void) { tool_check_all(check_crossing, 50); }

/* A triangle and a sphere that move so that its centre is in the triangle at some time, and others that do not. */
static void test_crossing_way(void)
{
    unsigned long long seed = 67;
    sb_tool_def def = tool_good_def(SB_TOOL_SPHERE);
    sbi_tool *tool = tool_make(&def);
    for (int i = 0; i < 500; i++) {
        sb_pose from = tool_random_pose(&seed, 1), to = tool_random_pose(&seed, 1);
        double time = tool_random(&seed, 0.05, 0.95);
        sb_vec3 meeting[3], start[3], end[3], at, far = sb_v3_scale(10, tool_random_direction(&seed));
        at = sb_v3_madd(from.position, REAL(time), sb_v3_sub(to.position, from.position));
        tool_triangle_round(&seed, at, 0.5, meeting);
        for (int k = 0; k < 3; k++) {
            sb_vec3 way = tool_random_vector(&seed, 0.5);
            start[k] = sb_v3_madd(meeting[k], REAL(-time), way);
            end[k] = sb_v3_madd(meeting[k], REAL(1 - time), way);
        }
        CHECK(skeleton_passes(tool, NULL, &from, start, NULL, &to, end));
        for (int k = 0; k < 3; k++)
            start[k] = sb_v3_add(start[k], far), end[k] = sb_v3_add(end[k], far);
        CHECK(!skeleton_passes(tool, NULL, &from, start, NULL, &to, end));
    }
    sbi_tool_destroy(tool);
}

/* ---- what is refused ---- */

/* Nothing is allocated, the tool is untouched, the message names the field. */
static void tool_refuse(const sb_tool_def *def, sb_result result, const char *field)
{
    scene_memory memory;
    sb_allocator allocator = scene_allocator(&memory);
    sbi_tool *tool = NULL;
    sb_error error;
    memset(&memory, 0, sizeof memory);
    memset(&error, 0, sizeof error);
    CHECK_RESULT(sbi_tool_create(def, &allocator, NULL, &tool, &error), result);
    CHECK_RESULT(sbi_tool_create(def, &allocator, NULL, &tool, NULL), result);
    CHECK(tool == NULL);
    CHECK_INT(memory.live, 0);
    if (!CHECK(strstr(error.message, field) != NULL))
        printf("'%s' does not name %s\n", error.message, field);
}

static void test_refused(void)
{
    const sb_real none[] = {0, REAL(-1), REAL(1e-12), REAL(1e12)};
    const sb_real nan = REAL(NAN), infinite = REAL(INFINITY);
    sb_tool_def def;
    check_bad_numbers();
    memset(&def, 0, sizeof def);
    tool_refuse(&def, SB_ERROR_ARGUMENT, "sb_default_tool_def");
    for (int i = 0; i < 4; i++) {
        def = tool_good_def(SB_TOOL_SPHERE), def.radius = none[i];
        tool_refuse(&def, SB_ERROR_ARGUMENT, "def.radius");
        def = tool_good_def(SB_TOOL_CAPSULES), def.radius = none[i];
        tool_refuse(&def, SB_ERROR_ARGUMENT, "def.radius");
        def = tool_good_def(SB_TOOL_BOX), def.half.y = none[i];
        tool_refuse(&def, SB_ERROR_ARGUMENT, "def.half.y");
        if (i > 0) {
            def = tool_good_def(SB_TOOL_BOX), def.radius = none[i];
            tool_refuse(&def, SB_ERROR_ARGUMENT, "def.radius");
        }
    }
    def = tool_good_def(SB_TOOL_SPHERE), def.radius = nan;
    tool_refuse(&def, SB_ERROR_NOT_FINITE, "def.radius");
    def = tool_good_def(SB_TOOL_BOX), def.half.z = nan;
    tool_refuse(&def, SB_ERROR_NOT_FINITE, "def.half.z");
    def = tool_good_def(SB_TOOL_BOX), def.half.x = REAL(0.09);
    tool_refuse(&def, SB_ERROR_ARGUMENT, "def.radius");
    def = tool_good_def((sb_tool_shape)0);
    tool_refuse(&def, SB_ERROR_ARGUMENT, "def.shape");
    def = tool_good_def((sb_tool_shape)6);
    tool_refuse(&def, SB_ERROR_ARGUMENT, "def.shape");
    def = tool_good_def(SB_TOOL_PLANE), def.pose.position.x = nan;
    tool_refuse(&def, SB_ERROR_NOT_FINITE, "def.pose.position");
    def = tool_good_def(SB_TOOL_PLANE), def.pose.rotation.w = infinite;
    tool_refuse(&def, SB_ERROR_NOT_FINITE, "def.pose.rotation");
    def = tool_good_def(SB_TOOL_PLANE), def.pose.rotation.w = 0;
    tool_refuse(&def, SB_ERROR_ARGUMENT, "def.pose.rotation");
    def = tool_good_def(SB_TOOL_PLANE), def.friction = REAL(-0.1);
    tool_refuse(&def, SB_ERROR_ARGUMENT, "def.friction");
    def = tool_good_def(SB_TOOL_PLANE), def.friction = nan;
    tool_refuse(&def, SB_ERROR_NOT_FINITE, "def.friction");
    CHECK_RESULT(sbi_tool_create(NULL, NULL, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    sbi_tool_destroy(NULL);
}

static void test_refused_chains(void)
{
    sb_vec3 points[SB_TOOL_MAX_POINTS + 1];
    sb_tool_def def = tool_good_def(SB_TOOL_CAPSULES);
    check_bad_numbers();
    for (int i = 0; i <= SB_TOOL_MAX_POINTS; i++)
        points[i] = sb_v3(REAL(i), 0, 0);
    def.points = points;
    for (int count = -1; count < 2; count++) {
        def.point_count = count;
        tool_refuse(&def, SB_ERROR_ARGUMENT, "def.points");
    }
    def.point_count = SB_TOOL_MAX_POINTS + 1;
    tool_refuse(&def, SB_ERROR_ARGUMENT, "def.points");
    def.point_count = SB_TOOL_MAX_POINTS;
    sbi_tool_destroy(tool_make(&def));
    points[7] = points[6];
    tool_refuse(&def, SB_ERROR_ARGUMENT, "def.points[7]");
    points[7].z = REAL(NAN);
    tool_refuse(&def, SB_ERROR_NOT_FINITE, "def.points[7]");
    points[7].z = REAL(1e10);
    tool_refuse(&def, SB_ERROR_ARGUMENT, "def.points[7]");
    points[7].z = 0, points[7].x = 6 * (1 + SB_EPSILON);
    tool_refuse(&def, SB_ERROR_ARGUMENT, "def.points[7]");
    def.points = NULL;
    tool_refuse(&def, SB_ERROR_ARGUMENT, "def.points");
}

static void test_refused_meshes(void)
{
    unsigned long long seed = 53;
    tool_mesh_case c;
    sb_tool_def def;
    sb_mesh other, box = scene_box(SB_TET4, 1, 1, 1, sb_v3(1, 1, 1), 0);
    check_bad_numbers();
    if (!tool_make_mesh_case(&seed, 0, 16, &c))
        return;
    def = c.base.def;
    for (int i = 0; i < 4; i++) {
        static const int cells[] = {-1, 0, 15, 129};
        def.cells = cells[i];
        tool_refuse(&def, SB_ERROR_ARGUMENT, "def.cells");
    }
    def = c.base.def, def.surface = NULL;
    tool_refuse(&def, SB_ERROR_ARGUMENT, "def.surface");
    def.surface = &box;
    tool_refuse(&def, SB_ERROR_UNSUPPORTED, "sb_surface_triangulate");
    other = c.mesh, def.surface = &other;
    other.element_count--;
    tool_refuse(&def, SB_ERROR_MESH, "def.surface must be closed");
    other.element_count = 0;
    tool_refuse(&def, SB_ERROR_MESH, "def.surface");
    other = c.mesh;
    for (int t = 0; t < other.element_count; t++) { /* inside out */
        int *corners = other.elements + 3 * t, first = corners[0];
        corners[0] = corners[1], corners[1] = first;
    }
    tool_refuse(&def, SB_ERROR_MESH, "def.surface");
    other.elements[7] = -1;
    tool_refuse(&def, SB_ERROR_INDEX, "def.surface");
    other.nodes[3].y = REAL(NAN);
    tool_refuse(&def, SB_ERROR_NOT_FINITE, "def.surface");
    tool_free_mesh_case(&c);
    if (tool_make_mesh_case(&seed, 0, 16, &c)) { /* a plate */
        def = c.base.def;
        for (int i = 0; i < c.mesh.node_count; i++)
            c.mesh.nodes[i].x *= REAL(0.01);
        tool_refuse(&def, SB_ERROR_UNSUPPORTED, "def.cells");
        tool_free_mesh_case(&c);
    }
    if (tool_make_mesh_case(&seed, 0, 16, &c)) { /* as far off as lets its nodes lie side by side */
        double far = 5e8, scale = 1e3 * (double)SB_EPSILON * far / c.length;
        def = c.base.def;
        for (int i = 0; i < c.mesh.node_count; i++)
            c.mesh.nodes[i] = sb_v3_madd(sb_v3(REAL(far), 0, 0), REAL(scale), c.mesh.nodes[i]);
        tool_refuse(&def, SB_ERROR_ARGUMENT, "too far");
        tool_free_mesh_case(&c);
    }
    sb_mesh_free(&box);
}

/* Every allocation fails in turn: nothing is left, nor made. */
static void tool_fail_memory(const sb_tool_def *def)
{
    int done = 0;
    for (int at = 1; at < 1000 && !done; at++) {
        scene_memory memory;
        sb_allocator allocator = scene_allocator(&memory);
        sbi_tool *tool = NULL;
        sb_error error;
        memset(&memory, 0, sizeof memory);
        memory.fail_at = at;
        if (sbi_tool_create(def, &allocator, NULL, &tool, &error) == SB_OK)
            done = at > 1;
        else
            CHECK(error.result == SB_ERROR_MEMORY && !tool);
        CHECK_INT(memory.live, done);
        sbi_tool_destroy(tool);
        CHECK_INT(memory.live, 0);
    }
    CHECK(done);
}

static void test_failing_memory(void)
{
    unsigned long long seed = 59;
    tool_mesh_case c;
    for (int i = 0; i < TOOL_SHAPES; i++) {
        sb_tool_def def = tool_good_def(tool_shapes[i]);
        tool_fail_memory(&def);
    }
    if (!tool_make_mesh_case(&seed, 0, 16, &c))
        return;
    tool_fail_memory(&c.base.def);
    tool_free_mesh_case(&c);
}

CHECK_SUITE(tool, {"distance", test_distance}, {"box samples", test_box_samples}, {"gradient", test_gradient},
            {"lipschitz", test_lipschitz}, {"batch", test_batch}, {"skeleton", test_skeleton},
            {"absurd points", test_absurd_points}, {"box core", test_box_core}, {"poses", test_poses},
            {"pose check", test_pose_check}, {"chain moved", test_chain_moved}, {"bounds", test_bounds},
            {"motion", test_motion}, {"mesh distance", test_mesh_distance}, {"mesh smooth", test_mesh_smooth},
            {"mesh beyond", test_mesh_beyond}, {"mesh skeleton", test_mesh_skeleton}, {"mesh common", test_mesh_common},
            {"mesh absurd points", test_mesh_absurd_points}, {"mesh middle", test_mesh_middle},
            {"mesh threads", test_mesh_threads}, {"crossing side", test_crossing_side}, {"crossing", test_crossing},
            {"crossing way", test_crossing_way}, {"refused", test_refused}, {"refused chains", test_refused_chains},
            {"refused meshes", test_refused_meshes}, {"failing memory", test_failing_memory});
