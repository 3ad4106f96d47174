/* Cuts of quadratic tetrahedra: what holds for tet4 holds for them. */
#include "cut_blade.h"

static block_options quad_default(int lattice)
{
    block_options options = block_default(lattice);
    options.element = SB_TET10;
    options.nx = 4;
    options.ny = 3;
    options.nz = 3;
    return options;
}

/* ---- planes ------------------------------------------------------------------------------------------------------ */

static void test_plane(void)
{
    for (int i = 0; i < 3; i++) {
        block_options options = quad_default(intervals_of[i]);
        block b = block_make(&options);
        sb_cut_info info;
        totals before, after;
        block_shake(&b);
        block_step(&b, 4);
        before = totals_of(&b);
        info = block_cut_plane(&b, sb_v3(REAL(0.031), REAL(0.02), REAL(0.025)), sb_v3(1, REAL(0.2), REAL(-0.1)));
        after = totals_of(&b);
        CHECK_INT(info.parts, 2);
        CHECK(info.links > 0 && info.cells > 0 && info.nodes > 0);
        check_pieces(&b);
        check_totals_but(&before, &after, 1e-2);
        printf("m %d elastic %g\n", intervals_of[i], after.elastic / before.elastic - 1);
        info = block_cut_plane(&b, sb_v3(REAL(0.031), REAL(0.02), REAL(0.025)), sb_v3(1, REAL(0.2), REAL(-0.1)));
        CHECK_INT(info.parts, 2);
        block_step(&b, 20);
        check_pieces(&b);
        block_free(&b);
    }
}

/* Parts through nodes and along faces: 2, 4 and 8. */
static void test_counts(void)
{
    for (int i = 0; i < 3; i++) {
        block_options options = quad_default(intervals_of[i]);
        block b;
        sb_vec3 middle = sb_v3(REAL(0.03), REAL(0.04 / 3), REAL(0.05 / 3));
        options.shake = 0;
        b = block_make(&options);
        CHECK_INT(block_cut_plane(&b, middle, sb_v3(1, 0, 0)).parts, 2);
        CHECK_INT(block_cut_plane(&b, middle, sb_v3(0, 1, 0)).parts, 4);
        CHECK_INT(block_cut_plane(&b, middle, sb_v3(0, 0, 1)).parts, 8);
        check_pieces(&b);
        block_step(&b, 2);
        block_free(&b);
    }
}

/* ---- cuts at random ---------------------------------------------------------------------------------------------- */

static void test_random_cuts(void)
{
    unsigned long long seed = 3;
    int rounds = check_quick() ? 1 : check_rounds(3), strokes = 5;
    for (int i = 0; i < 3; i++)
        for (int round = 0; round < rounds; round++) {
            block_options options = quad_default(intervals_of[i]);
            block b = block_make(&options);
            size_t size;
            void *state;
            uint64_t hash;
            block_shake(&b);
            block_step(&b, 3);
            state = state_of(&b, &size);
            hash = sb_body_state_hash(b.body);
            for (int stroke = 0; stroke < strokes; stroke++) {
                sb_vec3 triangles[18];
                int count = strip_random(triangles, &seed);
                totals before = totals_of(&b), after;
                sb_cut_info info = block_cut(&b, triangles, count);
                after = totals_of(&b);
                CHECK_INT(info.parts, b.body->component_count);
                check_pieces(&b);
                check_totals_but(&before, &after, 0.03);
                printf("m %d elastic %g\n", intervals_of[i], after.elastic / before.elastic - 1);
                block_step(&b, 1);
            }
            load(&b, state, size);
            CHECK(sb_body_state_hash(b.body) == hash);
            CHECK_OK(sb_body_live_check(b.body, NULL));
            free(state);
            block_free(&b);
        }
}

CHECK_SUITE(cut_quad, {"a plane parts a shaking block", test_plane}, {"crossing planes through nodes", test_counts},
            {"random cuts change no totals", test_random_cuts});
