/* Tests of kdtree: against brute force, ties, degenerate clouds, bad input, memory. */
#include "scene.h"

#include "register.h"

static sb_real squared_distance(sb_vec3 a, sb_vec3 b)
{
    sb_vec3 d = sb_v3_sub(a, b);
    return d.x * d.x + d.y * d.y + d.z * d.z;
}

/* Points of a kind: 0 random, 1 on a grid (many equal distances), 2 in a plane, 3 in a line, 4 in one place. */
static sb_vec3 point_of(int kind, unsigned long long *seed)
{
    sb_real x = REAL(check_random_in(seed, -1, 1)), y = REAL(check_random_in(seed, -1, 1)),
            z = REAL(check_random_in(seed, -1, 1));
    if (kind == 1)
        return sb_v3(REAL(floor(4 * (double)x)), REAL(floor(4 * (double)y)), REAL(floor(4 * (double)z)));
    if (kind == 4)
        return sb_v3(1, 2, 3);
    return kind == 2 ? sb_v3(x, y, REAL(0.3)) : kind == 3 ? sb_v3(x, x, x) : sb_v3(x, y, z);
}

/* What the k nearest must be: picked one after the other. */
static void check_nearest(const reg_kdtree *tree, const sb_vec3 *points, int count, sb_vec3 query, int k)
{
    int found[40], taken[400] = {0}, n = reg_kdtree_k_nearest(tree, query, k, found, NULL);
    sb_real squared[40], nearest = -1;
    CHECK_INT(n, 0); /* squared distances are needed */
    n = reg_kdtree_k_nearest(tree, query, k, found, squared);
    if (!CHECK_INT(n, k < count ? k : count))
        return;
    for (int i = 0; i < n; i++) {
        int best = -1;
        for (int j = 0; j < count; j++)
            if (!taken[j] && (best < 0 || squared_distance(points[j], query) < squared_distance(points[best], query)))
                best = j;
        taken[best] = 1;
        if (!CHECK_INT(found[i], best) || !CHECK(squared[i] >= squared_distance(points[best], query) &&
                                                 squared[i] <= squared_distance(points[best], query)))
            return;
    }
    CHECK_INT(reg_kdtree_nearest(tree, query, SB_REAL_MAX, &nearest), found[0]);
    CHECK(nearest >= squared[0] && nearest <= squared[0]);
}

static void test_brute_force(void)
{
    unsigned long long seed = 11;
    sb_vec3 points[400];
    static const int counts[8] = {1, 2, 7, 8, 9, 64, 65, 400};
    for (int kind = 0; kind < 5; kind++)
        for (int c = 0; c < 8; c++) {
            reg_kdtree *tree = NULL;
            for (int i = 0; i < counts[c]; i++)
                points[i] = point_of(kind, &seed);
            if (!CHECK_OK(reg_kdtree_create(points, counts[c], NULL, &tree, NULL)))
                return;
            CHECK_INT(reg_kdtree_count(tree), counts[c]);
            for (int q = 0; q < 30; q++) {
                sb_vec3 query = q % 3 == 0 ? points[q % counts[c]] : point_of(q % 3 - 1, &seed);
                check_nearest(tree, points, counts[c], query, 1 + q);
            }
            reg_kdtree_destroy(tree);
        }
}

static void test_radius(void)
{
    unsigned long long seed = 3;
    sb_vec3 points[300];
    int found[300], seen[300];
    reg_kdtree *tree = NULL;
    for (int i = 0; i < 300; i++)
        points[i] = point_of(i % 2, &seed);
    if (!CHECK_OK(reg_kdtree_create(points, 300, NULL, &tree, NULL)))
        return;
    for (int q = 0; q < 50; q++) {
        sb_vec3 query = point_of(0, &seed);
        sb_real radius = REAL(check_random_in(&seed, 0, 3)), squared = -1;
        int expected = 0, n = reg_kdtree_within(tree, query, radius, found, 300), nearest;
        memset(seen, 0, sizeof seen);
        for (int i = 0; i < n; i++)
            seen[found[i]]++;
        for (int i = 0; i < 300; i++) {
            int inside = squared_distance(points[i], query) <= radius * radius;
            expected += inside;
            CHECK_INT(seen[i], inside);
        }
        CHECK_INT(n, expected);
        CHECK_INT(reg_kdtree_within(tree, query, radius, NULL, 0), expected);
        nearest = reg_kdtree_nearest(tree, query, radius, &squared);
        CHECK((nearest >= 0) == (expected > 0) && (nearest >= 0) == (squared >= 0));
    }
    found[2] = -7; /* only what there is room for is written */
    CHECK_INT(reg_kdtree_within(tree, sb_v3(0, 0, 0), 100, found, 2), 300);
    CHECK_INT(found[2], -7);
    CHECK_INT(reg_kdtree_nearest(tree, points[17], 0, NULL) >= 0, 1); /* the limit itself is within */
    reg_kdtree_destroy(tree);
}

/* Answers do not depend on the order of the points, but for their numbers. */
static void test_order(void)
{
    unsigned long long seed = 5;
    sb_vec3 points[500], turned[500];
    reg_kdtree *a = NULL, *b = NULL;
    for (int i = 0; i < 500; i++)
        turned[499 - i] = points[i] = point_of(0, &seed);
    if (!CHECK_OK(reg_kdtree_create(points, 500, NULL, &a, NULL)) ||
        !CHECK_OK(reg_kdtree_create(turned, 500, NULL, &b, NULL)))
        return;
    for (int q = 0; q < 200; q++) {
        sb_vec3 query = point_of(0, &seed);
        int found = reg_kdtree_nearest(a, query, SB_REAL_MAX, NULL);
        CHECK_INT(found, 499 - reg_kdtree_nearest(b, query, SB_REAL_MAX, NULL));
    }
    reg_kdtree_destroy(a);
    reg_kdtree_destroy(b);
}

static void test_scale(void)
{
    unsigned long long seed = 9;
    sb_vec3 points[200], query = sb_v3(REAL(0.3), REAL(0.1), REAL(-0.2));
    sb_real scales[3] = {REAL(1e-12), 1, REAL(1e12)};
    int first = -1;
    for (int s = 0; s < 3; s++) {
        reg_kdtree *tree = NULL;
        seed = 9;
        for (int i = 0; i < 200; i++)
            points[i] = sb_v3_scale(scales[s], point_of(0, &seed));
        if (!CHECK_OK(reg_kdtree_create(points, 200, NULL, &tree, NULL)))
            return;
        if (s == 0)
            first = reg_kdtree_nearest(tree, sb_v3_scale(scales[s], query), SB_REAL_MAX, NULL);
        CHECK_INT(reg_kdtree_nearest(tree, sb_v3_scale(scales[s], query), SB_REAL_MAX, NULL), first);
        reg_kdtree_destroy(tree);
    }
}

static void test_bad_input(void)
{
    sb_vec3 points[3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, bad;
    check_bad_numbers();
    sb_real infinite = SB_REAL_MAX * 2, squared = 7;
    reg_kdtree *tree = NULL;
    int indices[3] = {-9, -9, -9};
    sb_error error;
    CHECK_RESULT(reg_kdtree_create(NULL, 3, NULL, &tree, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_kdtree_create(points, 0, NULL, &tree, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_kdtree_create(points, -1, NULL, &tree, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(reg_kdtree_create(points, 3, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    points[1].y = infinite - infinite;
    CHECK_RESULT(reg_kdtree_create(points, 3, NULL, &tree, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.node, 1);
    points[1].y = SB_REAL_MAX;
    CHECK_RESULT(reg_kdtree_create(points, 3, NULL, &tree, &error), SB_ERROR_ARGUMENT);
    CHECK(tree == NULL && strstr(error.message, "point 1"));
    points[1].y = 0;
    if (!CHECK_OK(reg_kdtree_create(points, 3, NULL, &tree, &error)))
        return;
    for (int k = 0; k < 4; k++) {
        bad = sb_v3(0, k == 1 ? infinite : 0, k == 2 ? infinite - infinite : 0);
        bad.x = k == 0 ? infinite - infinite : k == 3 ? SB_REAL_MAX : 0; /* the last is finite, and too far */
        CHECK_INT(reg_kdtree_nearest(tree, bad, SB_REAL_MAX, &squared), -1);
        CHECK_INT(reg_kdtree_within(tree, bad, SB_REAL_MAX, indices, 3), 0);
        CHECK_INT(reg_kdtree_k_nearest(tree, bad, 0, indices, &squared), 0);
    }
    CHECK_INT(reg_kdtree_nearest(tree, points[0], -1, &squared), -1);
    CHECK_INT(reg_kdtree_nearest(tree, points[0], infinite - infinite, &squared), -1);
    CHECK_INT(reg_kdtree_nearest(NULL, points[0], 1, &squared), -1);
    CHECK_INT(reg_kdtree_within(tree, points[0], -1, indices, 3), 0);
    CHECK(indices[0] == -9 && squared > 6);
    CHECK_INT(reg_kdtree_count(NULL), 0);
    reg_kdtree_destroy(tree);
    reg_kdtree_destroy(NULL);
}

static void test_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    unsigned long long seed = 1;
    sb_vec3 points[100];
    sb_error error;
    int needed;
    reg_kdtree *tree = NULL;
    for (int i = 0; i < 100; i++)
        points[i] = point_of(0, &seed);
    CHECK_OK(reg_kdtree_create(points, 100, &allocator, &tree, NULL));
    CHECK_INT(memory.live, 1);
    reg_kdtree_destroy(tree);
    CHECK_INT(memory.live, 0);
    needed = memory.calls;
    for (int fail = 1; fail <= needed; fail++) {
        tree = NULL;
        memory.calls = 0;
        memory.fail_at = fail;
        CHECK_RESULT(reg_kdtree_create(points, 100, &allocator, &tree, &error), SB_ERROR_MEMORY);
        CHECK(tree == NULL && memory.live == 0);
    }
}

/* Many points in few places, and in sorted order, take no longer. */
static void test_many(void)
{
    int count = 200000;
    sb_vec3 *points = (sb_vec3 *)malloc((size_t)count * sizeof *points);
    for (int kind = 0; points && kind < 3; kind++) {
        reg_kdtree *tree = NULL;
        sb_real squared;
        for (int i = 0; i < count; i++)
            points[i] = kind == 0 ? sb_v3(1, 1, 1) : kind == 1 ? sb_v3(REAL(i), 0, 0) : sb_v3(REAL(i % 3), 0, 0);
        if (!CHECK_OK(reg_kdtree_create(points, count, NULL, &tree, NULL)))
            break;
        CHECK_INT(reg_kdtree_nearest(tree, sb_v3(REAL(1.4), 1, 1), SB_REAL_MAX, &squared), kind == 0 ? 0 : 1);
        reg_kdtree_destroy(tree);
    }
    free(points);
}

CHECK_SUITE(kdtree, {"brute force", test_brute_force}, {"radius", test_radius}, {"order", test_order},
            {"scale", test_scale}, {"bad input", test_bad_input}, {"memory", test_memory}, {"many", test_many});
