/* Bevels of needles in tissue: curvatures by both laws, and helices of bevels that turn, against closed forms, for
 * random curvatures, angles, speeds, steps, meshes and rolls, whatever holds the needle. */
#include "needle_scene.h"

typedef struct bevel_case {
    needle_scene scene;
    double dt, advance, twist, roll; /* s; m a step; rad/m; rad of m2 from y about -z */
} bevel_case;

/* A wide block of `young`, the needle's tip 1 mm above it. */
static bevel_case random_case(ndl_follow follow, double young, unsigned long long *seed)
{
    bevel_case c;
    needle_scene *s = &c.scene;
    double edge = check_random_in(seed, 0.011, 0.019);
    *s = needle_scene_default();
    s->size = sb_v3(REAL(0.09), REAL(0.09), REAL(0.11));
    for (int k = 0; k < 3; k++)
        s->cells[k] = (int)((k < 2 ? 0.09 : 0.11) / edge + 0.5);
    s->materials[0].young = REAL(young), s->materials[0].poisson = REAL(0.45);
    s->frictions[0].friction = 5, s->frictions[0].cutting = REAL(0.1);
    ndl_rod_section_preset(NDL_NITINOL_083, &s->needle_def.section);
    s->needle_def.follow = follow;
    s->needle_def.base = sb_v3(REAL(0.0457), REAL(0.0443), REAL(0.122));
    s->needle_def.length = REAL(0.011);
    c.dt = check_random_in(seed, 0.005, 0.05);
    c.advance = check_random_in(seed, 0.0003, 0.0012);
    c.twist = 0;
    c.roll = check_random_in(seed, 0, 6.28);
    s->needle_def.director = sb_v3(REAL(-cos(c.roll)), REAL(-sin(c.roll)), 0);
    return c;
}

/* The tip's pose as it comes in, with the roll that it then has. */
static ndl_tip_pose entry_pose(const bevel_case *c)
{
    ndl_tip_pose pose;
    pose.position = sb_v3(c->scene.needle_def.base.x, c->scene.needle_def.base.y, c->scene.size.z);
    pose.frame.t = sb_v3(0, 0, -1);
    pose.frame.m1 = c->scene.needle_def.director;
    pose.frame.m2 = sb_v3_cross(pose.frame.t, pose.frame.m1);
    return ndl_tip_turn(&pose, REAL(c->twist * 0.001));
}

/* To a depth (m); places of the tip at a quarter of it, 0.6 of it and all of it. */
static int insert(bevel_case *c, double depth, sb_vec3 places[3])
{
    const double shares[3] = {0.25, 0.6, 1};
    ndl_command command = needle_command(c->advance / c->dt, c->twist * c->advance / c->dt);
    int found = 0;
    if (!needle_scene_make(&c->scene))
        return 0;
    for (int i = 0; i < 1000 && found < 3; i++) {
        if (!needle_scene_run(&c->scene, c->dt, 1, command))
            return 0;
        if ((double)ndl_needle_depth(c->scene.needles[0]) >= shares[found] * depth)
            places[found++] = needle_tip(c->scene.needles[0]);
    }
    return CHECK(found == 3);
}

/* Of the circle through three points (1/m). */
static double curvature(const sb_vec3 p[3])
{
    sb_vec3 a = sb_v3_sub(p[1], p[0]), b = sb_v3_sub(p[2], p[1]), c = sb_v3_sub(p[2], p[0]);
    return 2 * (double)sb_v3_norm(sb_v3_cross(a, c)) /
           ((double)sb_v3_norm(a) * (double)sb_v3_norm(b) * (double)sb_v3_norm(c));
}

/* How far the needle has gone out of the plane in which its bevel looks (m). */
static double off_plane(const bevel_case *c, sb_vec3 place)
{
    ndl_tip_pose pose = entry_pose(c);
    return fabs((double)sb_v3_dot(sb_v3_sub(place, pose.position), pose.frame.m1));
}

static double set_law(bevel_case *c, ndl_bevel_law law, unsigned long long *seed)
{
    ndl_bevel *bevel = &c->scene.needle_def.bevel;
    sb_real expected = 0;
    bevel->law = law;
    bevel->curvature = REAL(check_random_in(seed, 2, 10));
    bevel->angle = REAL(check_random_in(seed, 0.005, 0.025));
    bevel->guide = REAL(check_random_in(seed, 0.004, 0.008));
    CHECK_OK(ndl_bevel_curvature(bevel, 0, bevel->guide, &expected));
    return (double)expected;
}

/* In rigid tissue both laws give what ndl_bevel_curvature says. */
static void test_rigid(void)
{
    unsigned long long seed = 29;
    for (int i = 0; i < (check_quick() ? 4 : 12); i++) {
        ndl_follow follow = i % 2 ? NDL_EMBED : NDL_REMESH;
        bevel_case c = random_case(follow, 1e9, &seed);
        double expected = set_law(&c, i / 2 % 2 ? NDL_BEVEL_CURVATURE : NDL_BEVEL_ANGLE, &seed);
        sb_vec3 places[3];
        if (insert(&c, 0.07, places)) {
            double found = curvature(places), plane = off_plane(&c, places[2]);
            if (!CHECK(fabs(found - expected) < (follow == NDL_EMBED ? 0.01 : 0.05) * expected) || !CHECK(plane < 2e-4))
                printf("program %d: %.3f, not %.3f per m; %.2f mm out of the plane\n", i, found, expected, 1e3 * plane);
        }
        needle_scene_free(&c.scene);
    }
}

/* A turning bevel draws the helix of its turn from the skin on, whatever the turn in a step and within the first edge:
 * a fast one goes straight, but for a tilt of curvature/twist. */
static void test_spin(void)
{
    unsigned long long seed = 4;
    for (int i = 0; i < (check_quick() ? 4 : 8); i++) {
        ndl_follow follow = i % 2 ? NDL_EMBED : NDL_REMESH;
        bevel_case c = random_case(follow, 1e9, &seed);
        const double depth = 0.09, bend = check_random_in(&seed, 4, 10);
        sb_vec3 places[3];
        c.twist = (i % 4 < 2 ? 1 : -1) * 100 * pow(13, check_random(&seed));
        c.scene.needle_def.bevel.curvature = REAL(bend);
        if (insert(&c, depth, places)) {
            ndl_tip_pose start = entry_pose(&c),
                         end = ndl_helix_pose(&start, REAL(bend), REAL(c.twist), ndl_needle_depth(c.scene.needles[0]));
            double off = (double)sb_v3_norm(sb_v3_sub(places[2], end.position));
            if (!CHECK(off < (follow == NDL_EMBED ? 2e-4 : 5e-4)))
                printf("program %d, %.0f rad/m: %.2f mm off\n", i, c.twist, 1e3 * off);
        }
        needle_scene_free(&c.scene);
    }
}

/* (4 EI / k)^(1/4), k that of Kelvin's line load between the bends' length and the needle's radius. */
static double bends(const bevel_case *c)
{
    const double young = (double)c->scene.materials[0].young, nu = (double)c->scene.materials[0].poisson;
    ndl_rod_stiffness stiffness = ndl_rod_stiffness_of(&c->scene.needle_def.section);
    double length = 0.01;
    for (int i = 0; i < 20; i++) {
        double k = 8 * 3.14159265358979 * young / (2 * (1 + nu)) * (1 - nu) /
                   ((3 - 4 * nu) * log(length / (double)c->scene.needle_def.section.radius));
        length = pow(4 * (double)stiffness.bending[0] / k, 0.25);
    }
    return length;
}

/* In soft tissue the curvature is the lag over the length of the shaft's bends, by both laws, where that is less than
 * in rigid tissue. With NDL_REMESH meshes change it. */
static void test_soft(void)
{
    unsigned long long seed = 8;
    for (int i = 0; i < (check_quick() ? 3 : 12); i++) {
        ndl_follow follow = i % 3 ? NDL_EMBED : NDL_REMESH;
        bevel_case c = random_case(follow, 5e4, &seed);
        ndl_bevel *bevel = &c.scene.needle_def.bevel;
        double lag = check_random_in(&seed, 0.03, 0.09), expected = lag / bends(&c);
        sb_vec3 places[3];
        bevel->law = i % 3 == 2 ? NDL_BEVEL_CURVATURE : NDL_BEVEL_ANGLE;
        bevel->curvature = 12;
        bevel->angle = bevel->lag = REAL(lag);
        if (insert(&c, 0.08, places)) {
            double found = curvature(places);
            if (!CHECK(fabs(found - expected) < (follow == NDL_EMBED ? 0.08 : 0.6) * expected))
                printf("program %d: %.3f, not %.3f per m\n", i, found, expected);
        }
        needle_scene_free(&c.scene);
    }
}

/* How far aside a tip comes does not depend on the mesh's edges. */
static void test_meshes(void)
{
    static const double edges[3] = {0.02, 0.0145, 0.01};
    double least = 1, most = 0;
    unsigned long long seed = 1;
    for (int i = 0; i < (check_quick() ? 2 : 3); i++) {
        bevel_case c = random_case(NDL_EMBED, 1e4, &seed);
        sb_vec3 places[3];
        for (int k = 0; k < 3; k++)
            c.scene.cells[k] = (int)((k < 2 ? 0.09 : 0.11) / edges[i] + 0.5);
        c.dt = 0.04, c.advance = 0.0008;
        c.scene.needle_def.bevel.curvature = 8;
        if (insert(&c, 0.08, places)) {
            ndl_tip_pose pose = entry_pose(&c);
            double aside = (double)sb_v3_dot(sb_v3_sub(places[2], pose.position), pose.frame.m2);
            least = fmin(least, aside), most = fmax(most, aside);
        }
        needle_scene_free(&c.scene);
    }
    CHECK_NEAR(most, 0.0138, 0.001);
    CHECK(most < 1.05 * least);
}

/* Turned in place between steps, a bevel bends the way from there on. */
static void test_turn_in_place(void)
{
    unsigned long long seed = 3;
    for (int i = 0; i < 2; i++) {
        bevel_case c = random_case(i ? NDL_EMBED : NDL_REMESH, 1e9, &seed);
        ndl_tip_pose before, after;
        sb_vec3 places[3];
        c.scene.needle_def.bevel.curvature = 8;
        if (insert(&c, 0.04, places)) {
            before = ndl_needle_tip(c.scene.needles[0]);
            for (int k = 0; k < 20; k++) /* a quarter of a turn */
                needle_scene_run(&c.scene, c.dt, 1, needle_command(0, 1.5707963 / (20 * c.dt)));
            while (ndl_needle_depth(c.scene.needles[0]) < REAL(0.08) &&
                   needle_scene_run(&c.scene, c.dt, 1, needle_command(c.advance / c.dt, 0)))
                ;
            after = ndl_tip_turn(&before, REAL(1.5707963));
            after = ndl_helix_pose(&after, 8, 0, ndl_needle_depth(c.scene.needles[0]) - REAL(0.04));
            CHECK(sb_v3_norm(sb_v3_sub(after.position, needle_tip(c.scene.needles[0]))) < REAL(1.2e-3));
        }
        needle_scene_free(&c.scene);
    }
}

/* A caller is told where the bend is the mesh's doing: in soft gel, of needles that the mesh follows. */
static void test_coarse(void)
{
    for (int k = 0; k < 4; k++) {
        needle_scene s = needle_scene_default();
        s.needle_def.follow = k % 2 ? NDL_EMBED : NDL_REMESH;
        s.needle_def.bevel.curvature = 8;
        ndl_rod_section_preset(NDL_NITINOL_083, &s.needle_def.section);
        for (int r = 0; r < 2; r++)
            s.materials[r].young = REAL(k < 2 ? 1e4 : 1e9);
        if (needle_scene_make(&s) && needle_scene_run(&s, 0.02, 4, needle_command(0.01, 0))) {
            CHECK_INT(s.info.coarse, 0); /* it has come to nothing yet */
            needle_scene_run(&s, 0.02, 60, needle_command(0.01, 0));
            CHECK_INT(s.info.coarse, k == 0);
        }
        needle_scene_free(&s);
    }
}

static void test_bad_bevels(void)
{
    const sb_real bad[] = {0, -1, REAL(NAN), REAL(INFINITY)};
    needle_scene s = needle_scene_default();
    ndl_needle *needle = NULL;
    if (needle_scene_make_body(&s)) {
        ndl_needle_def def = s.needle_def;
        def.body = s.body;
        for (int k = 0; k < 4; k++)
            for (int field = 0; field < 2; field++) {
                def.bevel = s.needle_def.bevel;
                def.bevel.law = NDL_BEVEL_ANGLE;
                def.bevel.angle = REAL(0.02);
                *(field ? &def.bevel.lag : &def.bevel.guide) = bad[k];
                CHECK_RESULT(ndl_needle_create(&def, &needle, &s.error),
                             k < 2 ? SB_ERROR_ARGUMENT : SB_ERROR_NOT_FINITE);
                CHECK(strstr(s.error.message, "bevel") != NULL);
            }
        def.bevel = s.needle_def.bevel;
        def.bevel.law = NDL_BEVEL_ANGLE;
        def.bevel.angle = REAL(1.4); /* it would turn by radians in an edge */
        CHECK_RESULT(ndl_needle_create(&def, &needle, &s.error), SB_ERROR_ARGUMENT);
        CHECK(needle == NULL);
    }
    needle_scene_free(&s);
}

CHECK_SUITE(needle_bevel, {"both laws in rigid tissue", test_rigid}, {"a bevel that spins", test_spin},
            {"both laws in soft tissue", test_soft}, {"meshes", test_meshes}, {"turned in place", test_turn_in_place},
            {"bad bevels", test_bad_bevels}, {"told where it is coarse", test_coarse});
