/* Explicit steps of bodies that random cuts part: how long they may be, and that they stay bounded. */
#include "cut_block.h"

static double worst_ratio(sb_element_type element, int lattice, const int n[3], double shake, sb_cut_front front,
                          int trials, unsigned long long seed)
{
    double worst = 1e9;
    for (int trial = 0; trial < trials; trial++) {
        block_options options = block_default(lattice);
        sb_real uncut = 0, cut = 0;
        block b;
        options.element = element;
        options.nx = n[0], options.ny = n[1], options.nz = n[2];
        options.shake = shake;
        options.front = front;
        options.integrator = SB_CENTRAL_DIFFERENCE;
        b = block_make(&options);
        CHECK_OK(sb_body_stable_step(b.body, &uncut, NULL));
        for (int k = 0; k < 1 + trial % 3; k++) {
            sb_vec3 triangles[18];
            if (trial % 2)
                block_cut(&b, triangles, strip_random(triangles, &seed));
            else {
                sb_vec3 middle = vector_in(0.01, 0.04, &seed);
                block_cut_plane(&b, middle, vector_in(-1, 1, &seed));
            }
            CHECK_OK(sb_body_stable_step(b.body, &cut, NULL));
            worst = fmin(worst, (double)(cut / uncut));
        }
        block_free(&b);
    }
    return worst;
}

/* Planes and strips that nobody chose leave steps of 0.3 of the uncut ones. */
static void test_steps(void)
{
    static const int cells[3][3] = {{6, 4, 5}, {4, 3, 3}, {3, 2, 2}};
    for (int element = 0; element < 2; element++)
        for (int front = 0; front < 2; front++) {
            double worst = 1e9;
            for (int k = 0; k < 9; k++)
                worst = fmin(worst, worst_ratio(element ? SB_TET10 : SB_TET4, intervals_of[k / 3], cells[k % 3],
                                                k % 3 == 1 ? 0 : 0.2, (sb_cut_front)front, check_quick() ? 2 : 10,
                                                (unsigned long long)(k % 3 + 7)));
            printf("   %s, %s: steps are %.3f of the uncut ones at least\n", element ? "tet10" : "tet4",
                   front ? "glue" : "lag", worst);
            CHECK(worst >= 0.3);
        }
}

/* A part without supports falls as one: g t^2 / 2, and does not turn. */
static void test_fall(void)
{
    for (int element = 0; element < 2; element++) {
        block_options options = block_default(2);
        const double g = 9.81;
        double most = 0, t = 0.05;
        sb_real longest = 0;
        block b;
        options.element = element ? SB_TET10 : SB_TET4;
        options.nx = 3, options.ny = options.nz = 2;
        options.integrator = SB_CENTRAL_DIFFERENCE;
        b = block_make(&options);
        block_cut_plane(&b, sb_v3(REAL(0.0277), REAL(0.02), REAL(0.025)), sb_v3(1, REAL(0.3), REAL(0.1)));
        CHECK_OK(sb_body_set_gravity(b.body, sb_v3(0, 0, REAL(-g))));
        CHECK_OK(sb_body_stable_step(b.body, &longest, NULL));
        CHECK(longest > 0);
        for (int i = 0; i < 10; i++)
            CHECK_OK(sb_body_step(b.body, REAL(t / 10), NULL));
        for (int i = 0; i < sb_body_node_count(b.body); i++) {
            sb_vec3 u = sb_body_displacements(b.body)[i];
            most = fmax(most, sb_v3_norm(sb_v3_sub(u, sb_v3(0, 0, REAL(-g * t * t / 2)))));
        }
        printf("   %s: nodes are off by %.1e of their fall at most\n", element ? "tet10" : "tet4",
               most / (g * t * t / 2));
        CHECK(most < scene_tolerance(1e-12, 1e3) * g * t * t / 2);
        block_free(&b);
    }
}

/* A body cut crosswise goes on for ten thousand steps, half as long as they may be at rest: its energy stays. */
static void test_long(void)
{
    for (int trial = 0; trial < (check_quick() ? 1 : 3); trial++) {
        block_options options = block_default(intervals_of[trial]);
        sb_real longest = 0;
        unsigned long long seed = (unsigned long long)trial + 3;
        totals before, after;
        int steps = check_quick() ? 500 : 10000;
        block b;
        options.element = SB_TET10;
        options.integrator = SB_CENTRAL_DIFFERENCE;
        options.nx = options.ny = options.nz = 2;
        b = block_make(&options);
        scene_fix_plane(b.body, &b.mesh, 0, 0, SB_XYZ);
        for (int k = 0; k < 2; k++) {
            sb_vec3 middle = vector_in(0.015, 0.03, &seed);
            block_cut_plane(&b, middle, vector_in(-1, 1, &seed));
        }
        block_shake_at(&b, 0.1);
        before = totals_of(&b);
        CHECK_OK(sb_body_stable_step(b.body, &longest, NULL));
        for (int i = 0; i < steps; i++)
            if (!CHECK_OK(sb_body_step(b.body, longest / 2, NULL)))
                break;
        after = totals_of(&b);
        printf("   lattice %d: %d steps leave %.3f of the energy\n", options.lattice, steps,
               (after.kinetic + after.elastic) / (before.kinetic + before.elastic));
        CHECK(after.kinetic + after.elastic < 1.2 * (before.kinetic + before.elastic));
        CHECK(after.kinetic + after.elastic > 0.5 * (before.kinetic + before.elastic));
        block_free(&b);
    }
}

/* Parts are where their material is, however their masses are spread: those of the two halves of a block. */
static void test_centres(void)
{
    for (int element = 0; element < 2; element++) {
        block_options options = block_default(2);
        sb_part parts[2];
        int count = 0;
        block b;
        memset(parts, 0, sizeof parts);
        options.element = element ? SB_TET10 : SB_TET4;
        options.nx = 3, options.ny = options.nz = 2, options.shake = 0;
        options.integrator = SB_CENTRAL_DIFFERENCE;
        b = block_make(&options);
        block_cut_plane(&b, sb_v3(block_size.x / 2, 0, 0), sb_v3(1, 0, 0));
        CHECK_OK(sb_body_parts(b.body, parts, 2, &count, NULL));
        CHECK_INT(count, 2);
        for (int p = 0; p < 2; p++) {
            double half = (double)parts[p].volume / 0.04 / 0.05 / 2; /* of its length */
            sb_vec3 x = parts[p].centre;
            CHECK_NEAR(parts[p].mass, 1000 * (double)parts[p].volume, scene_tolerance(1e-12, 64) * 0.06);
            CHECK_NEAR(x.x < REAL(0.03) ? x.x : REAL(0.06) - x.x, half, scene_tolerance(1e-13, 16));
        }
        block_free(&b);
    }
}

CHECK_SUITE(cut_explicit, {"random cuts leave long steps", test_steps}, {"loose parts fall", test_fall},
            {"centres of parts", test_centres}, {"ten thousand steps", test_long});
