/* Tests of rigid: compositions, and fits of exact, noisy, weighted and degenerate pairs. */
#include "check.h"

#include "register.h"

#define REAL(x) ((sb_real)(x))

static const sb_vec3 cloud[6] = {{REAL(0.1), 0, 0},           {0, REAL(0.2), 0},           {0, 0, REAL(0.3)},
                                 {REAL(-0.1), REAL(0.05), 0}, {REAL(0.07), REAL(0.1), -1}, {0, 0, 0}};

static reg_rigid some_motion(double angle)
{
    reg_rigid motion;
    motion.rotation = sb_quat_to_mat3(
        sb_quat_from_rotation_vector(sb_v3(REAL(0.48 * angle), REAL(-0.6 * angle), REAL(0.64 * angle))));
    motion.translation = sb_v3(REAL(0.3), -2, REAL(0.01));
    return motion;
}

static double gap(const reg_rigid *a, const reg_rigid *b)
{
    double most = 0;
    for (int i = 0; i < 6; i++)
        most = fmax(most, (double)sb_v3_norm(sb_v3_sub(reg_rigid_apply(a, cloud[i]), reg_rigid_apply(b, cloud[i]))));
    return most;
}

static void test_compose(void)
{
    reg_rigid a = some_motion(2), b = some_motion(-0.7), identity = reg_rigid_identity(), back = reg_rigid_inverse(&a);
    reg_rigid both = reg_rigid_compose(&a, &b), none = reg_rigid_compose(&back, &a);
    sb_vec3 p = reg_rigid_apply(&a, reg_rigid_apply(&b, cloud[4]));
    CHECK(sb_v3_norm(sb_v3_sub(p, reg_rigid_apply(&both, cloud[4]))) < 16 * SB_EPSILON);
    CHECK(gap(&none, &identity) < 16 * (double)SB_EPSILON);
    for (int k = 0; k <= 10; k++) {
        reg_rigid turned = some_motion(0.314159 * k);
        CHECK_NEAR(reg_rigid_angle(&turned), 0.314159 * k, 32 * (double)SB_EPSILON);
    }
}

static void test_fit(void)
{
    reg_rigid motion = some_motion(2.9), found;
    sb_vec3 to[6];
    sb_real weights[6] = {0, 1, 2, 1, 3, 1};
    for (int i = 0; i < 6; i++)
        to[i] = reg_rigid_apply(&motion, cloud[i]);
    CHECK_OK(reg_rigid_fit(cloud, to, NULL, 6, &found, NULL));
    CHECK(gap(&motion, &found) < 64 * (double)SB_EPSILON);
    to[0] = sb_v3(9, 9, 9); /* has no weight */
    CHECK_OK(reg_rigid_fit(cloud, to, weights, 6, &found, NULL));
    CHECK(gap(&motion, &found) < 64 * (double)SB_EPSILON);
    CHECK_OK(reg_rigid_fit(cloud + 1, to + 1, NULL, 3, &found, NULL)); /* a plane through three points */
    for (int i = 1; i < 4; i++)
        CHECK(sb_v3_norm(sb_v3_sub(reg_rigid_apply(&found, cloud[i]), to[i])) < 64 * SB_EPSILON);
}

/* A reflection is not given for mirrored points; one point or points in one place still give a rotation. */
static void test_degenerate(void)
{
    sb_vec3 mirrored[6], same[6];
    reg_rigid found;
    for (int i = 0; i < 6; i++) {
        mirrored[i] = sb_v3(-cloud[i].x, cloud[i].y, cloud[i].z);
        same[i] = sb_v3(1, 2, 3);
    }
    CHECK_OK(reg_rigid_fit(cloud, mirrored, NULL, 6, &found, NULL));
    CHECK_NEAR(sb_m3_det(found.rotation), 1, 32 * (double)SB_EPSILON);
    CHECK_OK(reg_rigid_fit(cloud, same, NULL, 6, &found, NULL));
    CHECK_NEAR(sb_m3_det(found.rotation), 1, 32 * (double)SB_EPSILON);
    CHECK_OK(reg_rigid_fit(cloud, same, NULL, 1, &found, NULL));
    CHECK(sb_v3_norm(sb_v3_sub(reg_rigid_apply(&found, cloud[0]), same[0])) < 32 * SB_EPSILON);
}

static void test_refusals(void)
{
    sb_vec3 bad[2] = {{0, 0, 0}, {0, REAL(NAN), 0}};
    sb_real none[6] = {0, 0, 0, 0, 0, 0}, negative[2] = {1, -1};
    reg_rigid found = some_motion(1), before = found;
    sb_error error;
    CHECK(reg_rigid_fit(NULL, cloud, NULL, 6, &found, &error) == SB_ERROR_ARGUMENT);
    CHECK(reg_rigid_fit(cloud, cloud, NULL, 0, &found, &error) == SB_ERROR_ARGUMENT);
    CHECK(reg_rigid_fit(cloud, cloud, none, 6, &found, &error) == SB_ERROR_ARGUMENT);
    CHECK(reg_rigid_fit(cloud, cloud, negative, 2, &found, &error) == SB_ERROR_ARGUMENT);
    CHECK(reg_rigid_fit(cloud, bad, NULL, 2, &found, &error) == SB_ERROR_NOT_FINITE);
    CHECK(memcmp(&found, &before, sizeof found) == 0);
}

CHECK_SUITE(rigid, {"compositions and angles", test_compose}, {"fits", test_fit}, {"degenerate fits", test_degenerate},
            {"refusals", test_refusals});
