/* Needles that tore out of tissue which their tips are still in are held again from where their shafts go in: no test
 * has made one tear (nothing diverges), so they are let go by hand. */
#define SB_SPLIT_BUILD
#include "../src/needle/needle_private.h"

#include "needle_scene.h"

static const double dt = 0.02, speed = 0.01;

/* A held needle so deep, in tissue that it draws along and that is pushed aside. */
static int deep_scene(needle_scene *s, unsigned long long *seed, double depth)
{
    ndl_command aside = needle_command(0, 0);
    *s = needle_scene_default();
    s->type = check_random(seed) < 0.5 ? SB_TET4 : SB_HEX8;
    s->needle_def.follow = NDL_EMBED;
    s->needle_def.edge_length = REAL(check_random_in(seed, 0.003, 0.012));
    s->needle_def.bevel.curvature = REAL(check_random_in(seed, 0, 10));
    s->body_def.slack = 0;
    s->turned = check_random(seed) < 0.5;
    if (!needle_scene_make(s))
        return 0;
    for (int i = 0; i < 400 && (double)ndl_needle_depth(s->needles[0]) < depth; i++)
        if (!needle_scene_run(s, dt, 1, needle_command(speed, 0)))
            return 0;
    aside.velocity = sb_v3(REAL(check_random_in(seed, -0.005, 0.005)), REAL(check_random_in(seed, -0.005, 0.005)), 0);
    return needle_scene_run(s, dt, 10, aside);
}

static void let_go(const needle_scene *s)
{
    ndli_held_leave(s->needles[0]);
    s->needles[0]->lost = NDLI_LOST_TORN;
}

static double law(const needle_scene *s, double depth)
{
    return (double)s->frictions[0].cutting + (double)s->frictions[0].friction * depth;
}

/* Held again at the depth it had, without a blow; it goes on by the law and comes out. */
static void test_again(void)
{
    unsigned long long seed = 31;
    for (int round = 0; round < (check_quick() ? 2 : 4); round++) {
        needle_scene s;
        double depth, most = 0;
        if (!CHECK(deep_scene(&s, &seed, check_random_in(&seed, 0.012, 0.025))))
            return;
        depth = (double)ndl_needle_depth(s.needles[0]);
        let_go(&s);
        CHECK(ndl_needle_depth(s.needles[0]) == 0);
        for (int i = 0; i < 60; i++) {
            if (!needle_scene_run(&s, dt, 1, needle_command(speed, 0)))
                break;
            if (i == 1)
                CHECK_NEAR(ndl_needle_depth(s.needles[0]), depth, 0.25 * depth);
            most = fmax(most, needle_push(&s) - law(&s, (double)ndl_needle_depth(s.needles[0])));
        }
        CHECK(ndl_needle_depth(s.needles[0]) > REAL(depth));
        if (!CHECK(most < 0.2 && s.needles[0]->lost == NDLI_LOST_NOT))
            printf("  round %d, %g m deep: %g N beyond the law\n", round, depth, most);
        needle_scene_run(&s, dt, 300, needle_command(-1.2 * speed, 0));
        CHECK(ndl_needle_depth(s.needles[0]) == 0);
        needle_scene_free(&s);
    }
}

/* One that is hardly in stays loose, until it is out, and comes in anew. */
static void test_shallow(void)
{
    unsigned long long seed = 5;
    needle_scene s;
    if (!CHECK(deep_scene(&s, &seed, 0.002)))
        return;
    let_go(&s);
    CHECK(needle_scene_run(&s, dt, 2, needle_command(0, 0)));
    CHECK(ndl_needle_depth(s.needles[0]) == 0 && s.needles[0]->lost == NDLI_LOST_TORN);
    CHECK(needle_scene_run(&s, dt, 40, needle_command(-speed, 0)));
    CHECK(s.needles[0]->lost == NDLI_LOST_NOT);
    CHECK(needle_scene_run(&s, dt, 80, needle_command(speed, 0)));
    CHECK(ndl_needle_depth(s.needles[0]) > REAL(0.004));
    needle_scene_free(&s);
}

/* A state knows. */
static void test_saved(void)
{
    unsigned long long seed = 6, bits;
    needle_scene s;
    void *state;
    size_t size;
    if (!CHECK(deep_scene(&s, &seed, 0.002)))
        return;
    let_go(&s);
    needle_scene_run(&s, dt, 1, needle_command(speed, 0));
    size = sb_body_state_size(s.body);
    state = malloc(size);
    CHECK_OK(sb_body_state_save(s.body, state, size));
    needle_scene_run(&s, dt, 50, needle_command(speed, 0));
    bits = needle_scene_bits(&s);
    CHECK(ndl_needle_depth(s.needles[0]) > 0);
    CHECK_OK(sb_body_state_load(s.body, state, size, NULL));
    CHECK(s.needles[0]->lost == NDLI_LOST_TORN);
    needle_scene_run(&s, dt, 50, needle_command(speed, 0));
    CHECK(needle_scene_bits(&s) == bits);
    free(state);
    needle_scene_free(&s);
}

CHECK_SUITE(needle_torn, {"held again", test_again}, {"hardly in", test_shallow}, {"saved", test_saved});
