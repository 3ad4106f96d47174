/* needle: paths of bevelled and bent tips, torsion, several needles, failures, and long random use. */
#include "needle_scene.h"

static const double dt = 0.02, speed = 0.01;

/* ---- paths in stiff gel ---- */

/* Gel that does not give way, deep enough for 10 cm; the needle bends towards +y. */
static needle_scene stiff_scene(double edge)
{
    needle_scene s = needle_scene_default();
    s.size = sb_v3(REAL(0.04), REAL(0.07), REAL(0.11));
    s.cells[0] = (int)(0.04 / edge + 0.5);
    s.cells[1] = (int)(0.07 / edge + 0.5);
    s.cells[2] = (int)(0.11 / edge + 0.5);
    s.materials[0].young = REAL(1e9);
    ndl_rod_section_preset(NDL_NITINOL_083, &s.needle_def.section);
    s.needle_def.base = sb_v3(REAL(0.0203), REAL(0.0211), REAL(0.161));
    s.needle_def.director = sb_v3(-1, 0, 0); /* m2 = t x m1 = -z x -x = y */
    s.needle_def.bevel.curvature = 8;
    s.needle_def.capacity = 64;
    return s;
}

enum { PATH = 1000 };
typedef struct path {
    sb_vec3 x[PATH];
    int count;
} path;

/* Steps of `length` each; the tip's places once it has a node of its own in the tissue, until it has gone `way` from
 * there. At half of the way the base makes half a turn when `turns` is 1; `twist` (rad/m) all the way. */
static void follow(needle_scene *s, double length, double way, int turns, double twist, path *p)
{
    double gone = 0;
    int half = 0;
    p->count = 0;
    for (int i = 0; i < 2 * PATH && gone < way && p->count < PATH; i++) {
        if (!needle_scene_run(s, dt, 1, needle_command(length / dt, twist * length / dt)))
            return;
        if (ndl_needle_body_node(s->needles[0], ndl_rod_node_count(ndl_needle_rod(s->needles[0])) - 1) < 0 ||
            ndl_needle_depth(s->needles[0]) < REAL(0.005))
            continue;
        p->x[p->count++] = needle_tip(s->needles[0]);
        gone += p->count > 1 ? (double)sb_v3_norm(sb_v3_sub(p->x[p->count - 1], p->x[p->count - 2])) : 0;
        if (turns && !half && gone >= way / 2) {
            half = 1;
            needle_scene_run(s, dt, 20, needle_command(0, 3.14159265358979 / (20 * dt)));
        }
    }
    CHECK(gone >= way);
}

/* Radius (m) of the circle through three points. */
static double circle(sb_vec3 a, sb_vec3 b, sb_vec3 c)
{
    sb_vec3 ab = sb_v3_sub(b, a), ac = sb_v3_sub(c, a), bc = sb_v3_sub(c, b);
    double area = (double)sb_v3_norm(sb_v3_cross(ab, ac));
    return (double)sb_v3_norm(ab) * (double)sb_v3_norm(ac) * (double)sb_v3_norm(bc) / (2 * area);
}

/* All circles through points a third of `count` apart, from `first` on, have the radius to `share`. */
static void check_radius(const path *p, int first, int count, double radius, double share)
{
    int third = count / 3;
    CHECK(first >= 0 && third > 3 && first + 3 * third <= p->count);
    for (int i = first; i + 2 * third < first + count; i++)
        CHECK_NEAR(circle(p->x[i], p->x[i + third], p->x[i + 2 * third]), radius, share * radius);
}

static void test_circle(void)
{
    static path p;
    needle_scene s = stiff_scene(0.012);
    if (needle_scene_make(&s)) {
        double plane = 0;
        follow(&s, 0.0005, 0.1, 0, 0, &p);
        check_radius(&p, 0, p.count, 1.0 / 8, 0.03);
        for (int i = 0; i < p.count; i++)
            plane = fmax(plane, fabs((double)(p.x[i].x - p.x[0].x)));
        CHECK(plane < 5e-4);
        CHECK(p.x[p.count - 1].y > p.x[0].y + REAL(0.02)); /* towards m2 */
    }
    needle_scene_free(&s);
}

/* The same needle and gel, with half a turn in the middle: the second circle is bent the other way. */
static void test_s_shape(void)
{
    static path p;
    needle_scene s = stiff_scene(0.012);
    if (needle_scene_make(&s)) {
        sb_vec3 before, after;
        int half;
        follow(&s, 0.0005, 0.1, 1, 0, &p);
        half = p.count / 2;
        check_radius(&p, 0, half, 1.0 / 8, 0.03);
        check_radius(&p, half + 4, p.count - half - 4, 1.0 / 8, 0.03);
        before = sb_v3_cross(sb_v3_sub(p.x[half / 2], p.x[0]), sb_v3_sub(p.x[half], p.x[half / 2]));
        after =
            sb_v3_cross(sb_v3_sub(p.x[half + half / 2], p.x[half]), sb_v3_sub(p.x[p.count - 1], p.x[half + half / 2]));
        CHECK(sb_v3_dot(before, after) < REAL(-0.9) * sb_v3_norm(before) * sb_v3_norm(after));
    }
    needle_scene_free(&s);
}

static void test_radius_of_meshes_and_steps(void)
{
    static const double edges[3] = {0.016, 0.01, 0.012}, steps[3] = {0.001, 0.001, 0.00025};
    static path p;
    for (int i = 0; i < 3; i++) {
        needle_scene s = stiff_scene(edges[i]);
        if (needle_scene_make(&s)) {
            int n;
            follow(&s, steps[i], 0.06, 0, 0, &p);
            n = p.count;
            if (CHECK(n > 10))
                CHECK_NEAR(circle(p.x[0], p.x[n / 2], p.x[n - 1]), 1.0 / 8, 0.03 / 8);
        }
        needle_scene_free(&s);
    }
}

/* A steady twist gives the helix that steer.h plans with: half a turn on, a helix is on the other side of its axis. */
static void test_helix(void)
{
    static path p;
    needle_scene s = stiff_scene(0.012);
    double half = 3.14159265358979 / sqrt(8.0 * 8 + 120.0 * 120), radius = (double)ndl_helix_radius(8, 120);
    if (needle_scene_make(&s)) {
        int n = (int)(half / 0.0005 + 0.5);
        sb_vec3 axis;
        follow(&s, 0.0005, 0.08, 0, 120, &p);
        for (int i = n; i + n < p.count; i++) {
            sb_vec3 middle = sb_v3_scale(REAL(0.5), sb_v3_add(p.x[i - n], p.x[i + n]));
            CHECK_NEAR(sb_v3_norm(sb_v3_sub(p.x[i], middle)), 2 * radius, 0.03 * 2 * radius);
        }
        axis = sb_v3_sub(p.x[2 * n], p.x[0]); /* and a whole turn on by the pitch along it */
        CHECK_NEAR(sb_v3_norm(axis), ndl_helix_pitch(8, 120), 0.01 * (double)ndl_helix_pitch(8, 120));
    }
    needle_scene_free(&s);
}

/* Soft tissue lets a needle bend less than stiff tissue does. */
static void test_soft_tissue_bends_less(void)
{
    static path p;
    double aside[2] = {0, 0};
    for (int i = 0; i < 2; i++) {
        needle_scene s = stiff_scene(0.014);
        s.materials[0].young = REAL(i ? 1e9 : 2e4);
        if (needle_scene_make(&s)) {
            follow(&s, 0.001, 0.06, 0, 0, &p);
            aside[i] = (double)(p.x[p.count - 1].y - p.x[0].y);
        }
        needle_scene_free(&s);
    }
    CHECK(aside[0] > 0);
    CHECK(aside[0] < 0.8 * aside[1]);
}

/* A pre-bent tip leaves its straight way towards its bend. */
static void test_bent_tip(void)
{
    double aside[3] = {0, 0, 0};
    for (int i = 0; i < 3; i++) {
        needle_scene s = needle_scene_default();
        ndl_rod_section_preset(NDL_NITINOL_083, &s.needle_def.section);
        s.needle_def.director = sb_v3(-1, 0, 0);
        s.needle_def.bend_length = REAL(i > 0 ? 0.015 : 0);
        s.needle_def.bend_curvature = REAL(i == 1 ? 10 : i == 2 ? -10 : 0);
        s.needle_def.base.z += REAL(0.004);
        if (needle_scene_make(&s)) {
            double start = (double)needle_tip(s.needles[0]).y;
            CHECK_NEAR(start - (double)s.needle_def.base.y, i == 0 ? 0 : i == 1 ? 1.123e-3 : -1.123e-3, 2e-5);
            needle_scene_run(&s, dt, 170, needle_command(speed, 0));
            aside[i] = (double)needle_tip(s.needles[0]).y - (double)s.needle_def.base.y;
        }
        needle_scene_free(&s);
    }
    CHECK(fabs(aside[0]) < 5e-4);
    CHECK(aside[1] > 0.0025);
    CHECK(aside[2] < -0.0025);
}

/* ---- torsion ---- */

/* Turn (rad) of the tip's m1 about the needle (-z) from +x; in (-pi, pi]. */
static double tip_turn(const needle_scene *s)
{
    sb_vec3 m1 = ndl_needle_tip(s->needles[0]).frame.m1;
    return atan2(-(double)m1.y, (double)m1.x);
}

/* Tissue holds the shaft against turning: the tip lags behind by what the torque winds the needle up, and follows. */
static void test_torsional_friction(void)
{
    needle_scene s = needle_scene_default();
    ndl_rod_stiffness stiffness;
    ndl_rod_section_preset(NDL_NITINOL_083, &s.needle_def.section);
    stiffness = ndl_rod_stiffness_of(&s.needle_def.section);
    s.frictions[0].twist_stiffness = 20;
    s.frictions[0].twist_friction = REAL(0.2);
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 160, needle_command(speed, 0))) {
        double depth = (double)ndl_needle_depth(s.needles[0]), free_length, torque, lag, start = tip_turn(&s);
        sb_vec3 force, moment;
        int entry = ndl_needle_entry(s.needles[0]);
        free_length = (double)sb_v3_norm(sb_v3_sub(ndl_rod_positions(ndl_needle_rod(s.needles[0]))[entry],
                                                   ndl_rod_positions(ndl_needle_rod(s.needles[0]))[1]));
        needle_scene_run(&s, dt, 5, needle_command(0, 0.5));
        CHECK(fabs(tip_turn(&s) - start) < 0.5 * 5 * dt * 0.5); /* at first it hardly turns */
        needle_scene_run(&s, dt, 95, needle_command(0, 0.5));
        ndl_needle_base_wrench(s.needles[0], &force, &moment);
        torque = -(double)moment.z;
        CHECK_NEAR(torque, 0.2 * depth, 0.03 * 0.2 * depth);
        lag = 100 * dt * 0.5 - (tip_turn(&s) - start);
        CHECK_NEAR(lag, 0.2 * depth * (free_length + 0.5 * depth) / (double)stiffness.twist, 0.1 * lag);
        start = tip_turn(&s); /* then it goes with the base */
        needle_scene_run(&s, dt, 20, needle_command(0, 0.5));
        CHECK_NEAR(tip_turn(&s) - start, 20 * dt * 0.5, 0.01);
        start = tip_turn(&s); /* back: first it stays */
        needle_scene_run(&s, dt, 10, needle_command(0, -0.5));
        CHECK_NEAR(tip_turn(&s), start, 0.05);
    }
    needle_scene_free(&s);
}

/* Without it the tip turns as the base does. */
static void test_free_turning(void)
{
    needle_scene s = needle_scene_default();
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 100, needle_command(speed, 0))) {
        double start = tip_turn(&s);
        sb_vec3 moment;
        needle_scene_run(&s, dt, 50, needle_command(0, 1));
        CHECK_NEAR(tip_turn(&s) - start, 1, 0.02);
        ndl_needle_base_wrench(s.needles[0], NULL, &moment);
        CHECK(fabs((double)moment.z) < 1e-4);
    }
    needle_scene_free(&s);
}

/* ---- sleeves ---- */

static void test_commands_move_the_sleeve(void)
{
    needle_scene s = needle_scene_default();
    if (needle_scene_make(&s)) {
        ndl_command command = needle_command(0, 0);
        const sb_vec3 *x;
        sb_vec3 axis;
        double length = (double)s.needle_def.length;
        CHECK_NEAR(ndl_needle_fed(s.needles[0]), 0, 0);
        CHECK_INT(ndl_needle_entry(s.needles[0]), ndl_rod_node_count(ndl_needle_rod(s.needles[0])));
        command.velocity = sb_v3(REAL(0.01), REAL(-0.02), REAL(0.03));
        command.angular_velocity = sb_v3(REAL(0.2), 0, 0);
        needle_scene_run(&s, 0.1, 5, command);
        x = ndl_rod_positions(ndl_needle_rod(s.needles[0]));
        CHECK(sb_v3_norm(sb_v3_sub(x[1], sb_v3_add(s.needle_def.base, sb_v3_scale(REAL(0.5), command.velocity)))) <
              REAL(scene_tolerance(1e-12, 10)));
        axis = sb_v3_sub(x[1], x[0]);
        axis = sb_v3_scale(1 / sb_v3_norm(axis), axis);
        CHECK_NEAR(axis.y, sin(0.1), scene_tolerance(1e-9, 100)); /* -z turned about x by 0.1 */
        CHECK_NEAR(axis.z, -cos(0.1), scene_tolerance(1e-9, 100));
        command = needle_command(-0.01, 0);
        needle_scene_run(&s, 0.1, 5, command);
        CHECK_NEAR(ndl_needle_fed(s.needles[0]), -0.005, scene_tolerance(1e-12, 10));
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(needle_tip(s.needles[0]), x[1])), length - 0.005, 1e-5);
    }
    needle_scene_free(&s);
}

static void test_move_base(void)
{
    needle_scene s = needle_scene_default();
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 100, needle_command(speed, 0))) {
        sb_vec3 place = sb_v3_add(s.needle_def.base, sb_v3(REAL(0.003), REAL(-0.002), REAL(0.004)));
        sb_vec3 way = sb_v3(REAL(0.1), REAL(0.05), -1), side = sb_v3(REAL(0.3), -1, 0), zero = sb_v3(0, 0, 0), axis, m1;
        const ndl_rod *rod = ndl_needle_rod(s.needles[0]);
        ndl_command still = needle_command(0, 0), bad = still;
        CHECK_RESULT(ndl_needle_move_base(NULL, place, way, side), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_needle_move_base(s.needles[0], place, zero, side), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_needle_move_base(s.needles[0], place, way, way), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_needle_move_base(s.needles[0], place, sb_v3(0, 0, 1), side), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_needle_move_base(s.needles[0], sb_v3(REAL(NAN), 0, 0), way, side), SB_ERROR_NOT_FINITE);
        CHECK_RESULT(ndl_needle_move_base(s.needles[0], place, way, sb_v3(0, REAL(INFINITY), 0)), SB_ERROR_NOT_FINITE);
        needle_scene_run(&s, dt, 1, still);
        CHECK(sb_v3_norm(sb_v3_sub(ndl_rod_positions(rod)[1], s.needle_def.base)) < REAL(1e-6));
        CHECK_OK(ndl_needle_move_base(s.needles[0], place, way, side));
        bad.twist = REAL(NAN); /* a step that fails leaves what was asked for */
        CHECK_RESULT(ndl_step(s.body, s.needles, 1, REAL(dt), &bad, NULL, NULL), SB_ERROR_NOT_FINITE);
        needle_scene_run(&s, dt, 1, still);
        CHECK(s.info.substeps > 1);
        axis = sb_v3_scale(1 / sb_v3_norm(way), way);
        m1 = ndl_rod_frame(rod, 0).m1;
        CHECK(sb_v3_norm(sb_v3_sub(ndl_rod_positions(rod)[1], place)) < REAL(scene_tolerance(1e-12, 10)));
        CHECK(sb_v3_norm(sb_v3_sub(ndl_rod_frame(rod, 0).t, axis)) < REAL(scene_tolerance(1e-9, 100)));
        side = sb_v3_madd(side, -sb_v3_dot(side, axis), axis);
        CHECK(sb_v3_dot(m1, side) > REAL(1 - 1e-5) * sb_v3_norm(side));
        needle_scene_run(&s, dt, 3, still); /* and there it stays */
        CHECK(sb_v3_norm(sb_v3_sub(ndl_rod_positions(rod)[1], place)) < REAL(scene_tolerance(1e-12, 10)));
    }
    needle_scene_free(&s);
}

/* ---- ends of the way ---- */

static void test_limits(void)
{
    needle_scene s = needle_scene_default();
    s.needle_def.capacity = 16;
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 100, needle_command(speed, 0))) {
        CHECK_INT(s.info.limited, 0);
        CHECK(!needle_scene_is_original(&s));
        needle_scene_run(&s, dt, 400, needle_command(-2 * speed, 0)); /* all of it into the sleeve */
        CHECK_INT(s.info.limited, 1);
        CHECK(ndl_needle_fed(s.needles[0]) > REAL(-0.05) && ndl_needle_fed(s.needles[0]) < REAL(-0.04));
        CHECK_INT(ndl_needle_entry(s.needles[0]), ndl_rod_node_count(ndl_needle_rod(s.needles[0])));
        CHECK(needle_scene_is_original(&s));
        CHECK_NEAR(needle_push(&s), 0, 1e-6);
        needle_scene_run(&s, dt, 1, needle_command(speed, 0));
        CHECK_INT(s.info.limited, 0);
    }
    needle_scene_free(&s);
    s = needle_scene_default(); /* no room for more nodes: it is fed no more */
    s.needle_def.capacity = 10;
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 10, needle_command(speed, 0))) {
        CHECK_INT(s.info.limited, 1);
        CHECK_NEAR(ndl_needle_fed(s.needles[0]), 0, 0);
    }
    needle_scene_free(&s);
}

/* A needle that begins in the tissue is refused: with its tip there, through it, from a sleeve within it, or all of it
 * within. Beside it is fine. */
static void test_begins_outside(void)
{
    const double base[6] = {0.091, 0.091, 0.03, 0.03, 0.091, -0.02}, length[6] = {0.07, 0.1, 0.06, 0.015, 0.05, 0.02};
    needle_scene s = needle_scene_default();
    needle_scene_make(&s);
    for (int i = 0; i < 6; i++) {
        ndl_needle_def def = s.needle_def;
        ndl_needle *more = NULL;
        sb_result result;
        def.body = s.body;
        def.base = sb_v3(REAL(0.011), REAL(0.013), REAL(base[i]));
        def.length = REAL(length[i]);
        result = ndl_needle_create(&def, &more, &s.error);
        CHECK_RESULT(result, i < 4 ? SB_ERROR_ARGUMENT : SB_OK);
        CHECK(i >= 4 || strstr(s.error.message, "already"));
        ndl_needle_destroy(more);
    }
    needle_scene_free(&s);
}

/* More nodes in the tissue than the needle may have: named, and the needle can go back. */
static void test_capacity(void)
{
    needle_scene s = needle_scene_default();
    ndl_command down = needle_command(0, 0);
    sb_result result = SB_OK;
    down.velocity = sb_v3(0, 0, REAL(-0.02));
    s.cells[0] = s.cells[1] = s.cells[2] = 8;
    s.needle_def.capacity = 10;
    s.needle_def.edge_length = REAL(0.012);
    if (needle_scene_make(&s)) {
        unsigned long long before = 0;
        for (int i = 0; i < 100 && result == SB_OK; i++) {
            before = needle_scene_bits(&s);
            result = ndl_step(s.body, s.needles, 1, REAL(dt), &down, &s.info, &s.error);
        }
        CHECK_RESULT(result, SB_ERROR_UNSUPPORTED);
        CHECK(strstr(s.error.message, "capacity") != NULL);
        CHECK(before == needle_scene_bits(&s));
        needle_scene_run(&s, dt, 200, needle_command(-0.01, 0));
        CHECK(needle_scene_is_original(&s));
    }
    needle_scene_free(&s);
}

/* At the far skin the tip stops: the hand feels it, nothing winds up, and it comes back as it went. */
static void test_far_side(void)
{
    needle_scene s = needle_scene_default();
    double last = 0;
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 180, needle_command(speed, 0))) {
        CHECK_INT(s.info.blocked, 0);
        needle_scene_run(&s, dt, 33, needle_command(speed, 0));
        CHECK_INT(s.info.blocked, 1);
        CHECK(ndl_needle_cutting(s.needles[0]) == SB_REAL_MAX);
        for (int i = 0; i < 5; i++) {
            last = needle_push(&s);
            needle_scene_run(&s, dt, 5, needle_command(speed, 0));
            CHECK(needle_push(&s) > last + 0.05);
            CHECK_INT(s.info.blocked, 1);
            CHECK_NEAR(ndl_needle_advance(s.needles[0]), 0, 0);
        }
        needle_scene_run(&s, dt, 80, needle_command(-speed, 0));
        CHECK_INT(s.info.blocked, 0);
        CHECK_NEAR(needle_push(&s), -20 * (double)ndl_needle_depth(s.needles[0]), 0.02);
        CHECK_NEAR(ndl_needle_cutting(s.needles[0]), 0.5, 1e-6);
        needle_scene_run(&s, dt, 180, needle_command(-speed, 0));
        CHECK(needle_scene_is_original(&s));
    }
    needle_scene_free(&s);
}

static void test_misses_the_tissue(void)
{
    needle_scene s = needle_scene_default();
    s.needle_def.base = sb_v3(REAL(0.2), REAL(0.1), REAL(0.091));
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 300, needle_command(speed, 1))) {
        CHECK(needle_tip(s.needles[0]).z < 0);
        CHECK_NEAR(needle_push(&s), 0, 1e-6);
        CHECK(needle_scene_is_original(&s));
        CHECK_NEAR(ndl_needle_fed(s.needles[0]), 0.06, 1e-5);
        CHECK_INT(ndl_needle_contact(s.needles[0], 3), NDL_FREE);
        CHECK_INT(ndl_needle_body_node(s.needles[0], 3), -1);
        CHECK_INT(ndl_needle_body_node(s.needles[0], -1), -1);
        CHECK_INT(ndl_needle_body_node(s.needles[0], 1000), -1);
        CHECK(sb_v3_norm(ndl_needle_contact_force(s.needles[0], 1000)) == 0);
    }
    needle_scene_free(&s);
}

/* ---- several needles ---- */

static void test_two_needles(void)
{
    needle_scene s = needle_scene_default();
    s.cells[0] = s.cells[1] = 6;
    if (needle_scene_make(&s) && needle_scene_add(&s, sb_v3(REAL(-0.012), 0, 0)) &&
        needle_scene_run(&s, dt, 150, needle_command(speed, 0))) {
        ndl_needle *swapped[2];
        ndl_command commands[2] = {needle_command(0, 0), needle_command(-speed, 0)};
        double push[2];
        sb_vec3 force;
        swapped[0] = s.needles[1];
        swapped[1] = s.needles[0];
        for (int i = 0; i < 2; i++) {
            ndl_needle_base_wrench(s.needles[i], &force, NULL);
            push[i] = -(double)force.z;
            CHECK_NEAR(push[i], 20 * (double)ndl_needle_depth(s.needles[i]) + 0.5, 0.03);
            CHECK(needle_drift(&s, s.needles[i]) < scene_tolerance(1e-6, 1000));
        }
        for (int i = 0; i < 200; i++) /* the list may come in any order: needle 0 leaves, 1 stays */
            CHECK_OK(ndl_step(s.body, swapped, 2, REAL(dt), commands, &s.info, &s.error));
        CHECK_INT(ndl_needle_entry(s.needles[0]), ndl_rod_node_count(ndl_needle_rod(s.needles[0])));
        CHECK(ndl_needle_depth(s.needles[1]) > REAL(0.02));
        CHECK_NEAR(ndl_needle_fed(s.needles[0]), -0.01, 1e-5);
        needle_scene_run(&s, dt, 200, needle_command(-speed, 0));
        CHECK(needle_scene_is_original(&s));
    }
    needle_scene_free(&s);
}

/* Two needles too near to each other; steps until they meet. Returns how many steps went well. */
static int near_needles(needle_scene *s)
{
    ndl_command commands[2] = {needle_command(speed, 0), needle_command(speed, 0)};
    *s = needle_scene_default();
    if (!needle_scene_make(s) || !needle_scene_add(s, sb_v3(REAL(-0.004), 0, REAL(0.002))))
        return -1;
    for (int i = 0; i < 200; i++) {
        unsigned long long before = needle_scene_bits(s);
        sb_result result = ndl_step(s->body, s->needles, 2, REAL(dt), commands, &s->info, &s->error);
        if (result == SB_OK)
            continue;
        CHECK_RESULT(result, SB_ERROR_UNSUPPORTED);
        CHECK(strstr(s->error.message, "element") && strstr(s->error.message, "needle"));
        CHECK(before == needle_scene_bits(s));
        return i;
    }
    check_that(0, "the needles meet", __FILE__, __LINE__);
    return -1;
}

/* The failed step leaves no trace: what follows has the same bits as without it. */
static void test_needles_that_meet(void)
{
    needle_scene s, other;
    int steps = near_needles(&s);
    ndl_command commands[2] = {needle_command(-speed, 0), needle_command(-speed, 1)};
    memset(&other, 0, sizeof other);
    if (steps > 0) {
        other = needle_scene_default();
        if (needle_scene_make(&other) && needle_scene_add(&other, sb_v3(REAL(-0.004), 0, REAL(0.002))))
            needle_scene_run(&other, dt, steps, needle_command(speed, 0));
        CHECK(needle_scene_bits(&s) == needle_scene_bits(&other));
        for (int i = 0; i < 5; i++) {
            CHECK_OK(ndl_step(s.body, s.needles, 2, REAL(dt), commands, NULL, &s.error));
            CHECK_OK(ndl_step(other.body, other.needles, 2, REAL(dt), commands, NULL, &s.error));
            CHECK(needle_scene_bits(&s) == needle_scene_bits(&other));
        }
        needle_scene_run(&s, dt, 20, commands[0]); /* once one is out the other can go in */
        commands[0] = needle_command(0, 0);
        commands[1] = needle_command(speed, 0);
        for (int i = 0; i < 100; i++)
            if (!CHECK_OK(ndl_step(s.body, s.needles, 2, REAL(dt), commands, NULL, &s.error)))
                break;
        CHECK(ndl_needle_depth(s.needles[1]) > REAL(0.008));
    }
    needle_scene_free(&s);
    needle_scene_free(&other);
}

/* Needles go in any order, in or out of the tissue; those that stay can go on. */
static void test_destruction(void)
{
    for (int first = 0; first < 3; first++) {
        needle_scene s = needle_scene_default();
        ndl_command in = needle_command(speed, 0);
        s.cells[0] = s.cells[1] = 6;
        if (needle_scene_make(&s) && needle_scene_add(&s, sb_v3(REAL(-0.012), 0, 0)) &&
            needle_scene_add(&s, sb_v3(0, REAL(0.013), REAL(0.03))) && needle_scene_run(&s, dt, 80, in)) {
            ndl_needle *gone = s.needles[first];
            ndl_needle_destroy(gone);
            for (int i = first; i < 2; i++)
                s.needles[i] = s.needles[i + 1];
            s.count = 2;
            needle_scene_run(&s, dt, 20, in);
            CHECK(needle_scene_is_sound(&s));
            CHECK(needle_scene_add(&s, sb_v3(REAL(0.009), REAL(-0.009), 0)) != NULL);
            needle_scene_run(&s, dt, 10, in);
            CHECK(needle_scene_is_sound(&s));
            while (s.count > 0)
                ndl_needle_destroy(s.needles[--s.count]);
            CHECK(needle_scene_is_original(&s));
            CHECK_RESULT(ndl_step(s.body, s.needles, 1, REAL(dt), NULL, NULL, NULL), SB_ERROR_ARGUMENT);
            CHECK_OK(sb_body_step(s.body, REAL(dt), NULL));
        }
        needle_scene_free(&s);
    }
    ndl_needle_destroy(NULL);
}

/* Steps of the tissue alone between those of both: needles stay on their nodes. */
static void test_tissue_steps_between(void)
{
    needle_scene s = needle_scene_default();
    s.body_def.gravity = sb_v3(0, 0, REAL(-9.81));
    if (needle_scene_make(&s))
        for (int i = 0; i < 150; i++) {
            CHECK_OK(sb_body_step(s.body, REAL(dt), NULL));
            if (!needle_scene_run(&s, dt, 1, needle_command(i < 90 ? speed : -speed, 0)))
                break;
            CHECK(needle_scene_is_sound(&s));
            CHECK(needle_drift(&s, s.needles[0]) >= 0 && needle_drift(&s, s.needles[0]) < scene_tolerance(1e-6, 1000));
        }
    needle_scene_free(&s);
}

/* ---- odd tissue and odd steps ---- */

static void test_odd_materials(void)
{
    static const double young[6] = {100, 1000, 1e9, 5e4, 5e4, 5e4}, poisson[6] = {0.4, 0.4, 0.4, 0, -0.5, 0.49};
    for (int i = 0; i < 6; i++) {
        needle_scene s = needle_scene_default();
        s.cells[0] = s.cells[1] = 3;
        s.materials[0].young = REAL(young[i]);
        s.materials[0].poisson = REAL(poisson[i]);
        if (needle_scene_make(&s) && needle_scene_run(&s, dt, 60, needle_command(2 * speed, 1))) {
            CHECK(needle_scene_is_sound(&s));
            if (young[i] > 1000)
                CHECK_NEAR(needle_push(&s), 0.5 + 20 * (double)ndl_needle_depth(s.needles[0]), 0.05);
            /* Gel of 100 Pa is only dented, and clings to the millimetre that is in. When that lets go the dent springs
             * back over the tip, which is then a centimetre deep: friction of 20 N/m on skin that yields by some 1 m/N
             * has let go of that when it is drawn out by 22 cm. */
            needle_scene_run(&s, dt, young[i] > 100 ? 80 : 550, needle_command(-2 * speed, 0));
            CHECK(needle_scene_is_sound(&s));
            CHECK(needle_scene_is_original(&s));
        }
        needle_scene_free(&s);
    }
}

/* No friction at all: the needle feels nothing, and the tissue neither. */
static void test_no_friction(void)
{
    needle_scene s = needle_scene_default();
    memset(s.frictions, 0, sizeof s.frictions);
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 150, needle_command(speed, 1))) {
        CHECK(ndl_needle_depth(s.needles[0]) > REAL(0.028));
        CHECK_NEAR(needle_push(&s), 0, 1e-3);
        sb_energy energy = {1, 0, 0};
        CHECK_OK(sb_body_energy(s.body, &energy));
        CHECK(energy.elastic < REAL(1e-6));
        CHECK_INT(s.info.consistent, 1);
    }
    needle_scene_free(&s);
}

static void test_odd_steps(void)
{
    static const double steps[4] = {1e-9, 1e-5, 1, 100};
    for (int i = 0; i < 4; i++) {
        needle_scene s = needle_scene_default();
        if (needle_scene_make(&s)) {
            double move = fmin(2e-4 / steps[i], 1);
            needle_scene_run(&s, dt, 50, needle_command(speed, 0));
            needle_scene_run(&s, dt, 50, needle_command(0, 0)); /* long steps go on with present speeds */
            needle_scene_run(&s, steps[i], 30, needle_command(move, 0));
            CHECK(needle_scene_is_sound(&s));
            CHECK(sb_v3_norm(sb_v3_sub(needle_tip(s.needles[0]), sb_v3(REAL(0.0213), REAL(0.0191), REAL(0.03)))) <
                  REAL(0.01));
            needle_scene_run(&s, dt, 150, needle_command(-speed, 0));
            CHECK(needle_scene_is_original(&s));
        }
        needle_scene_free(&s);
    }
}

/* Long steps are cut into substeps, which do about what short steps do. */
static void test_substeps(void)
{
    needle_scene s;
    double push[2] = {0, 0}, depth[2] = {0, 1};
    for (int i = 0; i < 2; i++) {
        s = needle_scene_default();
        if (needle_scene_make(&s)) {
            needle_scene_run(&s, i ? 0.7 : 0.01, i ? 3 : 210, needle_command(speed, 0));
            CHECK(i == 0 || s.info.substeps > 1);
            push[i] = needle_push(&s);
            depth[i] = (double)ndl_needle_depth(s.needles[0]);
        }
        needle_scene_free(&s);
    }
    CHECK_NEAR(depth[0], depth[1], 5e-4);
    CHECK_NEAR(push[0], push[1], 0.1 * push[0]); /* friction is that of the depth at the start of a substep */
    s = needle_scene_default();
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 1, needle_command(1, 0))) {
        CHECK(s.info.substeps >= 3);
        CHECK(needle_scene_is_sound(&s));
        CHECK_NEAR(ndl_needle_fed(s.needles[0]), 0.02, 1e-5);
    }
    needle_scene_free(&s);
}

/* ---- bad input ---- */

typedef void (*spoil)(ndl_needle_def *def);
static const ndl_friction bad_friction = {20, -1, 0, 0, 0}, nan_friction = {20, 0, 0, 0, REAL(NAN)};
static const ndl_membrane bad_strength = {{-1, 0}, -1, 1}, bad_thickness = {{-1, 0}, 1, 0},
                          same_sides = {{0, 0}, 1, REAL(0.001)}, no_face = {{0, 5}, 1, REAL(0.001)};

static void no_cookie(ndl_needle_def *d) { d->cookie = 0; }
static void no_body(ndl_needle_def *d) { d->body = NULL; }
static void nan_base(ndl_needle_def *d) { d->base.y = REAL(NAN); }
static void nan_direction(ndl_needle_def *d) { d->direction.y = REAL(INFINITY); }
static void nan_director(ndl_needle_def *d) { d->director.x = REAL(NAN); }
static void nan_gravity(ndl_needle_def *d) { d->gravity.z = REAL(-INFINITY); }
static void no_direction(ndl_needle_def *d) { d->direction = sb_v3(0, 0, 0); }
static void no_length(ndl_needle_def *d) { d->length = 0; }
static void nan_length(ndl_needle_def *d) { d->length = REAL(NAN); }
static void bad_edge(ndl_needle_def *d) { d->edge_length = REAL(-0.001); }
static void fine_edge(ndl_needle_def *d) { d->edge_length = REAL(1e-7); }
static void few_nodes(ndl_needle_def *d) { d->capacity = 7; }
static void many_nodes(ndl_needle_def *d) { d->capacity = 0x7fffffff; }
static void long_bend(ndl_needle_def *d) { d->bend_length = d->length; }
static void negative_bend(ndl_needle_def *d) { d->bend_length = REAL(-0.01); }
static void sharp_bend(ndl_needle_def *d) { d->bend_length = REAL(0.04), d->bend_curvature = 1000; }
static void nan_bend(ndl_needle_def *d) { d->bend_curvature = REAL(NAN); }
static void negative_slip(ndl_needle_def *d) { d->entry_slip = REAL(-0.01); }
static void long_slip(ndl_needle_def *d) { d->entry_slip = REAL(0.26); }
static void nan_slip(ndl_needle_def *d) { d->entry_slip = REAL(NAN); }
static void no_trials(ndl_needle_def *d) { d->max_trials = 0; }
static void negative_damping(ndl_needle_def *d) { d->damping_bending = -1; }
static void bad_section(ndl_needle_def *d) { d->section.radius = 0; }
static void bad_law(ndl_needle_def *d) { d->bevel.law = (ndl_bevel_law)0; }
static void nan_bevel(ndl_needle_def *d) { d->bevel.curvature = REAL(NAN); }
static void sharp_bevel(ndl_needle_def *d) { d->bevel.curvature = 1000; }
static void no_frictions(ndl_needle_def *d) { d->frictions = NULL, d->friction_count = 2; }
static void fewer_frictions(ndl_needle_def *d) { d->friction_count = -1; }
static void negative_friction(ndl_needle_def *d) { d->frictions = &bad_friction, d->friction_count = 1; }
static void undefined_friction(ndl_needle_def *d) { d->frictions = &nan_friction, d->friction_count = 1; }
static void no_membranes(ndl_needle_def *d) { d->membrane_count = 1; }
static void negative_membrane(ndl_needle_def *d) { d->membranes = &bad_strength, d->membrane_count = 1; }
static void flat_membrane(ndl_needle_def *d) { d->membranes = &bad_thickness, d->membrane_count = 1; }
static void same_membrane(ndl_needle_def *d) { d->membranes = &same_sides, d->membrane_count = 1; }
static void nowhere_membrane(ndl_needle_def *d) { d->membranes = &no_face, d->membrane_count = 1; }
static void tip_inside(ndl_needle_def *d) { d->length = REAL(0.07); }
static void through(ndl_needle_def *d) { d->length = REAL(0.12); }
static void base_inside(ndl_needle_def *d) { d->base.z = REAL(0.02), d->length = REAL(0.01), d->direction.z = 1; }

static void test_bad_definitions(void)
{
    static const struct {
        spoil change;
        sb_result result;
        const char *names;
    } cases[] = {
        {no_cookie, SB_ERROR_ARGUMENT, "ndl_default_needle_def"},
        {no_body, SB_ERROR_ARGUMENT, "body"},
        {nan_base, SB_ERROR_NOT_FINITE, "base"},
        {nan_direction, SB_ERROR_NOT_FINITE, "direction"},
        {nan_director, SB_ERROR_NOT_FINITE, "director"},
        {nan_gravity, SB_ERROR_NOT_FINITE, "gravity"},
        {no_direction, SB_ERROR_ARGUMENT, "direction"},
        {no_length, SB_ERROR_ARGUMENT, "length"},
        {nan_length, SB_ERROR_ARGUMENT, "length"},
        {bad_edge, SB_ERROR_ARGUMENT, "edge_length"},
        {fine_edge, SB_ERROR_ARGUMENT, "capacity"},
        {few_nodes, SB_ERROR_ARGUMENT, "capacity"},
        {many_nodes, SB_ERROR_MEMORY, ""},
        {long_bend, SB_ERROR_ARGUMENT, "bend_length"},
        {negative_bend, SB_ERROR_ARGUMENT, "bend_length"},
        {sharp_bend, SB_ERROR_ARGUMENT, "bend_curvature"},
        {nan_bend, SB_ERROR_ARGUMENT, "bend_curvature"},
        {negative_slip, SB_ERROR_ARGUMENT, "entry_slip"},
        {long_slip, SB_ERROR_ARGUMENT, "entry_slip"},
        {nan_slip, SB_ERROR_ARGUMENT, "entry_slip"},
        {no_trials, SB_ERROR_ARGUMENT, "max_trials"},
        {negative_damping, SB_ERROR_ARGUMENT, "damping"},
        {bad_section, SB_ERROR_ARGUMENT, "radius"},
        {bad_law, SB_ERROR_ARGUMENT, "bevel"},
        {nan_bevel, SB_ERROR_NOT_FINITE, "bevel"},
        {sharp_bevel, SB_ERROR_ARGUMENT, "bevel"},
        {no_frictions, SB_ERROR_ARGUMENT, "frictions"},
        {fewer_frictions, SB_ERROR_ARGUMENT, "frictions"},
        {negative_friction, SB_ERROR_ARGUMENT, "viscous"},
        {undefined_friction, SB_ERROR_ARGUMENT, "twist_friction"},
        {no_membranes, SB_ERROR_ARGUMENT, "membranes"},
        {negative_membrane, SB_ERROR_ARGUMENT, "membrane 0"},
        {flat_membrane, SB_ERROR_ARGUMENT, "membrane 0"},
        {same_membrane, SB_ERROR_ARGUMENT, "membrane 0"},
        {nowhere_membrane, SB_ERROR_ARGUMENT, "membrane 0"},
        {tip_inside, SB_ERROR_ARGUMENT, "skin"},
        {through, SB_ERROR_ARGUMENT, "skin"},
        {base_inside, SB_ERROR_ARGUMENT, "tissue"},
    };
    needle_scene s = needle_scene_default();
    scene_memory memory = {0, 0, 0, 0};
    ndl_needle *needle = NULL;
    if (!needle_scene_make_body(&s))
        return;
    CHECK_RESULT(ndl_needle_create(NULL, &needle, &s.error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_needle_create(&s.needle_def, NULL, &s.error), SB_ERROR_ARGUMENT);
    check_bad_numbers();
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        ndl_needle_def def = s.needle_def;
        int failures = check.failures;
        def.body = s.body;
        def.allocator = scene_allocator(&memory);
        cases[i].change(&def);
        memset(&s.error, 0, sizeof s.error);
        if (cases[i].change == many_nodes && sizeof(size_t) > 4)
            memory.fail_at = memory.calls + 2; /* hundreds of gigabytes may be there to be promised */
        CHECK_RESULT(ndl_needle_create(&def, &needle, &s.error), cases[i].result);
        memory.fail_at = 0;
        CHECK(needle == NULL);
        CHECK(strstr(s.error.message, cases[i].names) != NULL);
        CHECK_INT(memory.live, 0);
        if (cases[i].result != SB_ERROR_MEMORY)
            CHECK_RESULT(ndl_needle_create(&def, &needle, NULL), cases[i].result);
        if (check.failures > failures)
            printf("case %d: %s\n", (int)i, s.error.message);
    }
    needle_scene_free(&s);
}

static void test_bad_commands(void)
{
    needle_scene s = needle_scene_default(), other = s;
    check_bad_numbers();
    if (needle_scene_make(&s) && needle_scene_add(&s, sb_v3(REAL(-0.012), 0, 0)) && needle_scene_make(&other) &&
        needle_scene_run(&s, dt, 20, needle_command(speed, 0))) {
        unsigned long long before = needle_scene_bits(&s);
        ndl_needle *twice[2], *missing[2] = {NULL, NULL}, *stranger[2];
        ndl_command good[2] = {needle_command(0, 0), needle_command(0, 0)}, bad[2];
        twice[0] = twice[1] = stranger[0] = missing[0] = s.needles[0];
        stranger[1] = other.needles[0];
        CHECK_RESULT(ndl_step(NULL, s.needles, 2, REAL(dt), good, &s.info, &s.error), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_step(s.body, NULL, 2, REAL(dt), good, &s.info, &s.error), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_step(s.body, s.needles, 1, REAL(dt), good, &s.info, &s.error), SB_ERROR_ARGUMENT);
        CHECK(strstr(s.error.message, "1 needles given, the body has 2") != NULL);
        CHECK_RESULT(ndl_step(s.body, s.needles, 3, REAL(dt), good, &s.info, &s.error), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_step(s.body, s.needles, -1, REAL(dt), good, &s.info, &s.error), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_step(s.body, twice, 2, REAL(dt), good, &s.info, &s.error), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_step(s.body, missing, 2, REAL(dt), good, &s.info, &s.error), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_step(s.body, stranger, 2, REAL(dt), good, &s.info, &s.error), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_step(s.body, s.needles, 2, 0, good, &s.info, &s.error), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_step(s.body, s.needles, 2, REAL(-dt), good, &s.info, &s.error), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_step(s.body, s.needles, 2, REAL(NAN), good, &s.info, &s.error), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_step(s.body, s.needles, 2, REAL(INFINITY), good, &s.info, &s.error), SB_ERROR_ARGUMENT);
        for (int field = 0; field < 4; field++)
            for (int kind = 0; kind < 2; kind++) {
                sb_real wrong = kind ? REAL(INFINITY) : REAL(NAN);
                memcpy(bad, good, sizeof bad);
                *(field == 0   ? &bad[1].insertion
                  : field == 1 ? &bad[1].twist
                  : field == 2 ? &bad[1].velocity.y
                               : &bad[1].angular_velocity.z) = wrong;
                CHECK_RESULT(ndl_step(s.body, s.needles, 2, REAL(dt), bad, &s.info, &s.error), SB_ERROR_NOT_FINITE);
                CHECK(strstr(s.error.message, "command 1") != NULL);
            }
        memcpy(bad, good, sizeof bad);
        bad[0].insertion = 1000; /* 20 m in a step */
        CHECK_RESULT(ndl_step(s.body, s.needles, 2, REAL(dt), bad, &s.info, &s.error), SB_ERROR_ARGUMENT);
        CHECK(strstr(s.error.message, "substeps") != NULL);
        bad[0].insertion = SB_REAL_MAX;
        CHECK_RESULT(ndl_step(s.body, s.needles, 2, 1, bad, NULL, NULL), SB_ERROR_ARGUMENT);
        CHECK(before == needle_scene_bits(&s));
        CHECK_OK(ndl_step(s.body, s.needles, 2, REAL(dt), NULL, NULL, NULL));
    }
    needle_scene_free(&other);
    needle_scene_free(&s);
}

static void test_too_many_needles(void)
{
    needle_scene s = needle_scene_default();
    s.needle_def.base.z += REAL(0.01);
    if (needle_scene_make_body(&s)) {
        ndl_needle_def def = s.needle_def;
        ndl_needle *more = NULL;
        for (int i = 0; i < NDL_MAX_NEEDLES; i++)
            needle_scene_add(&s, sb_v3(REAL(0.002 * i), 0, 0));
        def.body = s.body;
        CHECK_RESULT(ndl_needle_create(&def, &more, &s.error), SB_ERROR_UNSUPPORTED);
        CHECK(more == NULL);
        needle_scene_run(&s, dt, 1, needle_command(speed, 0));
        ndl_needle_destroy(s.needles[--s.count]);
        needle_scene_add(&s, sb_v3(0, 0, 0));
        needle_scene_run(&s, dt, 1, needle_command(speed, 0));
    }
    needle_scene_free(&s);
}

/* ---- memory ---- */

/* Counts bytes, too. */
typedef struct byte_memory {
    scene_memory count;
    size_t bytes;
} byte_memory;

typedef union byte_head {
    size_t bytes;
    double align[2];
} byte_head;

static void *byte_alloc(void *user, size_t bytes)
{
    byte_memory *memory = (byte_memory *)user;
    byte_head *head = (byte_head *)scene_alloc(&memory->count, bytes + sizeof *head);
    if (!head)
        return NULL;
    head->bytes = bytes;
    memory->bytes += bytes;
    return head + 1;
}

static void byte_release(void *user, void *pointer)
{
    byte_memory *memory = (byte_memory *)user;
    byte_head *head = (byte_head *)pointer;
    if (!head)
        return;
    memory->bytes -= head[-1].bytes;
    scene_release(&memory->count, head - 1);
}

static sb_allocator byte_allocator(byte_memory *memory)
{
    sb_allocator allocator;
    allocator.alloc = byte_alloc;
    allocator.release = byte_release;
    allocator.user = memory;
    return allocator;
}

static const ndl_membrane skin = {{-1, 0}, 1, REAL(0.001)};

/* Every allocation of a creation fails in turn: nothing is left, and then it succeeds. */
static void test_creation_without_memory(void)
{
    needle_scene s = needle_scene_default();
    scene_memory memory = {0, 0, 0, 0};
    s.body_def.allocator = scene_allocator(&memory);
    if (needle_scene_make_body(&s)) {
        ndl_needle_def def = s.needle_def;
        ndl_needle *needle = NULL;
        int live, failures = 0;
        ndl_needle_destroy(needle_scene_add(&s, sb_v3(0, 0, 0))); /* the body keeps its list of those that follow it */
        s.count = 0;
        live = memory.live;
        def.body = s.body;
        def.allocator = scene_allocator(&memory);
        def.frictions = s.frictions;
        def.friction_count = 1;
        def.membranes = &skin;
        def.membrane_count = 1;
        for (;;) {
            sb_result result;
            memory.calls = 0;
            memory.fail_at = failures + 1;
            result = ndl_needle_create(&def, &needle, &s.error);
            memory.fail_at = 0;
            if (result == SB_OK)
                break;
            CHECK_RESULT(result, SB_ERROR_MEMORY);
            CHECK(needle == NULL);
            CHECK_INT(memory.live, live);
            if (++failures > 200)
                break;
        }
        CHECK(failures >= 6 && failures < 200);
        ndl_needle_destroy(needle);
        CHECK_INT(memory.live, live);
    }
    needle_scene_free(&s);
    CHECK_INT(memory.live, 0);
}

/* In and out; step by step, what fails for want of memory leaves all as it was and succeeds when there is some. */
static void insert_without_memory(int with_skin, int fail_at, int *calls)
{
    needle_scene s = needle_scene_default();
    scene_memory memory = {0, 0, 0, 0};
    s.cells[0] = s.cells[1] = s.cells[2] = 3;
    s.body_def.slack = REAL(0.001);
    s.body_def.allocator = s.needle_def.allocator = scene_allocator(&memory);
    s.needle_def.membranes = &skin; /* steps through it are begun anew */
    s.needle_def.membrane_count = with_skin;
    if (needle_scene_make(&s)) {
        memory.calls = 0;
        memory.fail_at = fail_at;
        for (int i = 0; i < 60; i++) {
            ndl_command command = needle_command(i < 35 ? 5 * speed : -7 * speed, 3);
            unsigned long long before = needle_scene_bits(&s);
            sb_result result = ndl_step(s.body, s.needles, 1, REAL(dt), &command, &s.info, &s.error);
            if (result != SB_OK) {
                CHECK_RESULT(result, SB_ERROR_MEMORY);
                CHECK(before == needle_scene_bits(&s) ||
                      (with_skin && strstr(s.error.message, "that comes first in the next step")));
                CHECK_OK(ndl_step(s.body, s.needles, 1, REAL(dt), &command, &s.info, &s.error));
            }
        }
        *calls = memory.calls;
        CHECK(needle_scene_is_sound(&s));
        CHECK(needle_scene_is_original(&s));
    }
    needle_scene_free(&s);
    CHECK_INT(memory.live, 0);
}

static void test_steps_without_memory(void)
{
    for (int with_skin = 0; with_skin < 2; with_skin++) {
        int calls = 0, unused;
        insert_without_memory(with_skin, 0, &calls);
        CHECK(calls > 3);
        for (int i = 1; i <= calls; i += check_quick() ? 5 : 1 + 2 * with_skin)
            insert_without_memory(with_skin, i, &unused);
    }
}

enum { ALL_STEPS = 40 };

static needle_scene scene_without_memory(sb_precond_kind kind)
{
    needle_scene s = needle_scene_default();
    s.cells[0] = s.cells[1] = s.cells[2] = 3;
    s.body_def.preconditioner = kind;
    return s;
}

static ndl_command command_at(int i) { return needle_command(i < 25 ? 5 * speed : -7 * speed, 3); }

/* The bits after each step of a scene whose memory lasts. */
static void play_with_memory(sb_precond_kind kind, unsigned long long *bits)
{
    needle_scene s = scene_without_memory(kind);
    if (needle_scene_make(&s))
        for (int i = 0; i < ALL_STEPS; i++) {
            ndl_command command = command_at(i);
            CHECK_OK(ndl_step(s.body, s.needles, 1, REAL(dt), &command, &s.info, &s.error));
            bits[i] = needle_scene_bits(&s);
        }
    needle_scene_free(&s);
}

/* From some allocation on all fail, in bodies that are made anew by each change of their mesh: a failed step is taken
 * back at once, or, where the mesh has changed, before the next step. What comes then is what comes without failures.
 */
static void fail_for_good(sb_precond_kind kind, int step, int first, const unsigned long long *bits)
{
    needle_scene s = scene_without_memory(kind);
    scene_memory memory = {0, 0, 0, 0};
    s.body_def.allocator = s.needle_def.allocator = scene_allocator(&memory);
    if (needle_scene_make(&s))
        for (int i = 0; i < ALL_STEPS; i++) {
            ndl_command command = command_at(i);
            if (i == step) {
                unsigned long long before = needle_scene_bits(&s);
                sb_result result;
                memory.fail_from = memory.calls + first;
                result = ndl_step(s.body, s.needles, 1, REAL(dt), &command, &s.info, &s.error);
                memory.fail_from = 0;
                if (result == SB_OK) /* it did without */
                    break;
                CHECK_RESULT(result, SB_ERROR_MEMORY);
                CHECK(needle_scene_bits(&s) == before || strstr(s.error.message, "take the failed step back"));
            }
            CHECK_OK(ndl_step(s.body, s.needles, 1, REAL(dt), &command, &s.info, &s.error));
            CHECK(i < step || needle_scene_bits(&s) == bits[i]);
        }
    needle_scene_free(&s);
    CHECK_INT(memory.live, 0);
}

static void test_no_memory_for_good(void)
{
    const sb_precond_kind kinds[4] = {SB_PRECOND_IC0, SB_PRECOND_FSAI, SB_PRECOND_CHOLESKY, SB_PRECOND_MULTIGRID};
    for (int k = 0; k < 4; k++) {
        unsigned long long bits[ALL_STEPS] = {0};
        play_with_memory(kinds[k], bits);
        for (int step = 3; step < 36; step += check_quick() ? 16 : 4)
            for (int first = 1; first < 200; first += 1 + first / (check_quick() ? 1 : 4))
                fail_for_good(kinds[k], step, first, bits);
    }
}

/* A step that has changed the mesh and then fails, without memory to take that back: body and needles wait, and the
 * next step takes it back first. */
static void test_undo_waits(void)
{
    needle_scene s[2];
    scene_memory memory = {0, 0, 0, 0};
    ndl_command down = needle_command(0, 0), up = needle_command(-0.01, 0);
    sb_result result = SB_OK;
    down.velocity = sb_v3(0, 0, REAL(-0.02));
    for (int k = 0; k < 2; k++) {
        s[k] = needle_scene_default();
        s[k].cells[0] = s[k].cells[1] = s[k].cells[2] = 8;
        s[k].needle_def.capacity = 10;
        s[k].needle_def.edge_length = REAL(0.012);
    }
    s[1].body_def.allocator = s[1].needle_def.allocator = scene_allocator(&memory);
    if (needle_scene_make(s) && needle_scene_make(s + 1)) {
        for (int i = 0; i < 100 && result == SB_OK; i++) {
            result = ndl_step(s[0].body, s[0].needles, 1, REAL(dt), &down, &s[0].info, &s[0].error);
            if (result == SB_OK)
                CHECK_OK(ndl_step(s[1].body, s[1].needles, 1, REAL(dt), &down, &s[1].info, &s[1].error));
        }
        CHECK_RESULT(result, SB_ERROR_UNSUPPORTED);
        memory.fail_from = memory.calls + 1;
        for (int again = 0; again < 2; again++) {
            CHECK_RESULT(ndl_step(s[1].body, s[1].needles, 1, REAL(dt), &down, NULL, &s[1].error), SB_ERROR_MEMORY);
            CHECK(strstr(s[1].error.message, "take the failed step back") != NULL);
        }
        CHECK(needle_scene_bits(s) != needle_scene_bits(s + 1));
        memory.fail_from = 0;
        for (int i = 0; i < 5; i++) {
            CHECK_OK(ndl_step(s[0].body, s[0].needles, 1, REAL(dt), &up, NULL, &s[0].error));
            CHECK_OK(ndl_step(s[1].body, s[1].needles, 1, REAL(dt), &up, NULL, &s[1].error));
            CHECK(needle_scene_bits(s) == needle_scene_bits(s + 1));
        }
    }
    needle_scene_free(s);
    needle_scene_free(s + 1);
    CHECK_INT(memory.live, 0);
}

/* While the mesh keeps to its slack, steps ask for no memory at all: not the first, and not with two needles in. */
static void test_steps_take_no_memory(void)
{
    needle_scene s = needle_scene_default();
    scene_memory memory = {0, 0, 0, 0};
    s.body_def.allocator = s.needle_def.allocator = scene_allocator(&memory);
    s.cells[0] = s.cells[1] = 6;
    s.body_def.slack = REAL(0.5);
    if (needle_scene_make(&s)) {
        needle_scene_add(&s, sb_v3(REAL(-0.012), 0, 0));
        memory.calls = 0;
        for (int cycle = 0; cycle < 2; cycle++) {
            needle_scene_run(&s, dt, 35, needle_command(4 * speed, 2));
            CHECK_INT(memory.calls, 0);
            CHECK(needle_scene_is_sound(&s)); /* the check asks for memory */
            memory.calls = 0;
            CHECK(ndl_needle_depth(s.needles[0]) > REAL(0.02));
            needle_scene_run(&s, dt, 38, needle_command(-4 * speed, 0));
            CHECK(needle_scene_is_original(&s));
        }
        CHECK_INT(memory.calls, 0);
    }
    needle_scene_free(&s);
    CHECK_INT(memory.live, 0);
}

/* Needles that come and go beside one that stays ask for no more memory each time. */
static void test_needles_that_come_and_go(void)
{
    needle_scene s = needle_scene_default();
    byte_memory memory = {{0, 0, 0, 0}, 0};
    size_t bytes = 0;
    s.body_def.allocator = s.needle_def.allocator = byte_allocator(&memory);
    s.cells[0] = s.cells[1] = 6;
    if (needle_scene_make(&s)) {
        for (int i = 0; i < 12; i++) {
            needle_scene_add(&s, sb_v3(REAL(-0.012), 0, 0));
            needle_scene_run(&s, dt, 20, needle_command(i == 0 ? speed : 0, 0));
            ndl_needle_destroy(s.needles[--s.count]);
            if (i == 1)
                bytes = memory.bytes;
        }
        CHECK(memory.bytes <= bytes);
    }
    needle_scene_free(&s);
    CHECK_INT(memory.count.live, 0);
    CHECK(memory.bytes == 0);
}

/* STATES */

/* ---- long random use ---- */

/* The sleeve strays about its first place; the needle goes in, back, turns and now and then is moved by hand. */
static ndl_command random_command(const needle_scene *s, unsigned long long *seed)
{
    ndl_command command = needle_command(check_random_in(seed, -0.015, 0.03), 0);
    sb_vec3 home = sb_v3_sub(s->needle_def.base, ndl_rod_positions(ndl_needle_rod(s->needles[0]))[1]);
    if (check_random(seed) < 0.3)
        command.twist = REAL(check_random_in(seed, -20, 20));
    if (check_random(seed) < 0.2)
        command.insertion = 0;
    command.velocity = sb_v3_scale(1, home);
    command.velocity.x += REAL(check_random_in(seed, -0.01, 0.01));
    command.velocity.y += REAL(check_random_in(seed, -0.01, 0.01));
    command.velocity.z += REAL(check_random_in(seed, -0.003, 0.003));
    return command;
}

/* Draws the needle out of the tissue; returns the steps it took. */
static int draw_out(needle_scene *s)
{
    int steps = 0;
    while (ndl_needle_entry(s->needles[0]) < ndl_rod_node_count(ndl_needle_rod(s->needles[0])) && steps < 500) {
        if (!needle_scene_run(s, dt, 1, needle_command(-0.04, 0)))
            break;
        steps++;
    }
    CHECK_INT(ndl_needle_entry(s->needles[0]), ndl_rod_node_count(ndl_needle_rod(s->needles[0])));
    return steps;
}

static void home_again(needle_scene *s)
{
    ndl_needle_def def = s->needle_def;
    CHECK_OK(ndl_needle_move_base(s->needles[0], def.base, def.direction, def.director));
    needle_scene_run(s, dt, 1, needle_command(0, 0));
    while (ndl_needle_fed(s->needles[0]) < 0)
        if (!needle_scene_run(s, dt, 1, needle_command(0.02, 0)))
            break;
}

typedef struct violence {
    int steps, failed, inconsistent, cycles;
} violence;

static void random_cycle(needle_scene *s, unsigned long long *seed, violence *v)
{
    int steps = 40 + (int)(80 * check_random(seed));
    ndl_command command = random_command(s, seed);
    for (int i = 0; i < steps; i++) {
        unsigned long long before = needle_scene_bits(s);
        sb_result result;
        if (i % 5 == 0)
            command = random_command(s, seed);
        result = ndl_step(s->body, s->needles, 1, REAL(dt), &command, &s->info, &s->error);
        v->steps++;
        v->inconsistent += result == SB_OK && !s->info.consistent;
        if (result != SB_OK) {
            v->failed++;
            if (v->failed < 5)
                printf("step %d: %s\n", v->steps, s->error.message);
            CHECK(before == needle_scene_bits(s));
            break;
        }
        if (i % 10 == 0 && !CHECK(needle_scene_is_sound(s)))
            break;
        CHECK(needle_drift(s, s->needles[0]) < scene_tolerance(1e-6, 1000));
    }
    v->steps += draw_out(s);
    v->cycles++;
    CHECK(needle_scene_is_original(s));
    CHECK(needle_scene_is_sound(s));
    home_again(s);
}

static void test_long_random_use(void)
{
    int most = getenv("CHECK_SLOW") ? 100000 : check_quick() ? 300 : 2000;
    unsigned long long seed = 11;
    needle_scene s = needle_scene_default();
    byte_memory memory = {{0, 0, 0, 0}, 0};
    violence v = {0, 0, 0, 0};
    size_t bytes;
    int live;
    s.body_def.allocator = s.needle_def.allocator = byte_allocator(&memory);
    s.frictions[0].viscous = 20;
    s.frictions[0].twist_stiffness = 1;
    s.frictions[0].twist_friction = REAL(0.01);
    s.needle_def.bevel.curvature = 6;
    ndl_rod_section_preset(NDL_NITINOL_083, &s.needle_def.section);
    if (needle_scene_make(&s)) {
        while (v.cycles < 3)
            random_cycle(&s, &seed, &v);
        bytes = memory.bytes;
        live = memory.count.live;
        while (v.steps < most)
            random_cycle(&s, &seed, &v);
        CHECK(memory.bytes < 2 * bytes);
        CHECK_INT(memory.count.live, live);
        CHECK(v.failed <= v.steps / 1000);
        CHECK(v.inconsistent <= 0.004 * v.steps);
        if (most > 2000)
            printf("%d steps, %d failed, %d inconsistent, %d cycles, %g times the memory\n", v.steps, v.failed,
                   v.inconsistent, v.cycles, (double)memory.bytes / (double)bytes);
    }
    needle_scene_free(&s);
    CHECK_INT(memory.count.live, 0);
}

/* ---- random scenes ---- */

static double draw(unsigned long long *seed, double low, double high) { return check_random_in(seed, low, high); }
static int happens(unsigned long long *seed, double share) { return check_random(seed) < share; }

/* Tissue and needle of any kind, with or without membranes, up to two needles near to each other, tilted. */
static int make_random_scene(needle_scene *s, unsigned long long *seed)
{
    static const ndl_membrane membranes[2] = {{{-1, 0}, 1, REAL(0.001)}, {{1, 0}, 2, REAL(0.002)}};
    *s = needle_scene_default();
    for (int i = 0; i < 3; i++)
        s->cells[i] = 3 + (int)draw(seed, 0, 3);
    s->layered = happens(seed, 0.4);
    for (int i = 0; i < 2; i++) {
        s->materials[i].young = REAL(happens(seed, 0.5) ? draw(seed, 3e3, 3e4) : draw(seed, 3e4, 1e6));
        s->materials[i].poisson = REAL(draw(seed, 0, 0.49));
        s->frictions[i].friction = REAL(draw(seed, 0, 100));
        s->frictions[i].viscous = REAL(happens(seed, 0.5) ? 0 : draw(seed, 0, 200));
        s->frictions[i].cutting = REAL(draw(seed, 0, 2));
        s->frictions[i].twist_stiffness = REAL(happens(seed, 0.5) ? 0 : draw(seed, 0, 10));
        s->frictions[i].twist_friction = REAL(draw(seed, 0, 0.05));
    }
    s->needle_def.membranes = s->layered ? membranes : NULL;
    s->needle_def.membrane_count = s->layered ? 2 : 0;
    ndl_rod_section_preset(happens(seed, 0.6) ? NDL_NITINOL_083 : NDL_STYLET_18G, &s->needle_def.section);
    s->needle_def.bevel.curvature = REAL(happens(seed, 0.5) ? 0 : draw(seed, 2, 20));
    s->needle_def.bend_length = REAL(happens(seed, 0.3) ? 0.01 : 0);
    s->needle_def.bend_curvature = REAL(draw(seed, -15, 15));
    s->body_def.integrator = happens(seed, 0.3) ? SB_EULER : SB_GENERALISED_ALPHA;
    s->body_def.damping_stiffness = REAL(happens(seed, 0.3) ? 0 : draw(seed, 0, 0.02));
    s->needle_def.gravity.z = REAL(happens(seed, 0.3) ? -9.81 : 0);
    s->needle_def.direction = sb_v3(REAL(draw(seed, -0.25, 0.25)), REAL(draw(seed, -0.25, 0.25)), -1);
    s->needle_def.base.x = REAL(draw(seed, 0.008, 0.032)) - REAL(0.04) * s->needle_def.direction.x;
    s->needle_def.base.y = REAL(draw(seed, 0.008, 0.032)) - REAL(0.04) * s->needle_def.direction.y;
    return needle_scene_make(s) &&
           (happens(seed, 0.6) ||
            needle_scene_add(s, sb_v3(REAL(s->needle_def.base.x > REAL(0.02) ? -0.012 : 0.012), 0, 0)) != NULL);
}

static ndl_command stray(const needle_scene *s, int k, unsigned long long *seed)
{
    ndl_command command = needle_command(draw(seed, -0.02, 0.045), happens(seed, 0.4) ? draw(seed, -30, 30) : 0);
    if (k == 0)
        command.velocity = sb_v3_sub(s->needle_def.base, ndl_rod_positions(ndl_needle_rod(s->needles[0]))[1]);
    command.velocity.x += REAL(draw(seed, -0.03, 0.03));
    command.velocity.y += REAL(draw(seed, -0.03, 0.03));
    if (happens(seed, 0.2))
        command.angular_velocity = sb_v3(REAL(draw(seed, -0.3, 0.3)), REAL(draw(seed, -0.3, 0.3)), 0);
    return command;
}

/* One step; a failure must leave everything. Returns its result. */
static sb_result careful_step(needle_scene *s, double step, const ndl_command *commands)
{
    unsigned long long before = needle_scene_bits(s);
    sb_result result = ndl_step(s->body, s->needles, s->count, REAL(step), commands, &s->info, &s->error);
    if (result != SB_OK)
        CHECK(before == needle_scene_bits(s));
    return result;
}

/* All needles can be drawn out, whatever has come to pass, and the mesh is then the original one. */
static void draw_all_out(needle_scene *s, double step)
{
    ndl_command commands[2] = {needle_command(-0.03, 0), needle_command(-0.03, 0)};
    int out = 0, failures = 0;
    for (int i = 0; i < 3000 && out < 5 && failures < 50; i++) {
        failures += careful_step(s, step, commands) != SB_OK;
        out++;
        for (int k = 0; k < s->count; k++)
            if (ndl_needle_entry(s->needles[k]) < ndl_rod_node_count(ndl_needle_rod(s->needles[k])))
                out = 0;
    }
    CHECK(out == 5);
    CHECK(needle_scene_is_original(s));
}

/* 100 steps of stray commands, then all out. */
static void run_random_scene(int scene, int *steps, int *inconsistent)
{
    unsigned long long seed = 1000003ULL * (unsigned long long)(scene + 1);
    needle_scene s;
    int failures = check.failures;
    for (int i = 0; i < 8; i++)
        check_random(&seed);
    if (make_random_scene(&s, &seed)) {
        double step = draw(&seed, 0.004, 0.05);
        ndl_command commands[2] = {needle_command(0, 0), needle_command(0, 0)};
        for (int i = 0; i < 100; i++) {
            for (int k = 0; k < s.count && i % 6 == 0; k++)
                commands[k] = stray(&s, k, &seed);
            if (careful_step(&s, step, commands) != SB_OK)
                commands[0] = commands[1] = needle_command(-0.03, 0);
            *inconsistent += !s.info.consistent;
            (*steps)++;
        }
        CHECK(needle_scene_is_sound(&s));
        draw_all_out(&s, step);
    }
    if (check.failures > failures)
        printf("random scene %d\n", scene);
    needle_scene_free(&s);
}

static void test_random_scenes(void)
{
    int most = getenv("CHECK_SLOW") ? 500 : check_quick() ? 2 : 10, steps = 0, inconsistent = 0;
    for (int scene = 0; scene < most; scene++)
        run_random_scene(scene, &steps, &inconsistent);
    CHECK(inconsistent <= 2 + steps / 250);
}

/* Meshes that have left a shaft millimetres beside its path: no step went on from there, not even one that draws the
 * needle back. */
static void test_beside_its_path(void)
{
    static const int scenes[] = {19, 91, 208, 391};
    int steps = 0, inconsistent = 0;
    for (int i = 0; i < (check_quick() ? 1 : 4); i++)
        run_random_scene(scenes[i], &steps, &inconsistent);
}

CHECK_SUITE(needle, {"a bevel cuts a circle", test_circle}, {"half a turn makes an S", test_s_shape},
            {"meshes and steps do not change the radius", test_radius_of_meshes_and_steps},
            {"a steady twist makes a helix", test_helix}, {"soft tissue bends it less", test_soft_tissue_bends_less},
            {"a bent tip", test_bent_tip}, {"torsional friction", test_torsional_friction},
            {"free turning", test_free_turning}, {"commands move the sleeve", test_commands_move_the_sleeve},
            {"move_base", test_move_base}, {"limits", test_limits}, {"capacity", test_capacity},
            {"the far side", test_far_side}, {"misses the tissue", test_misses_the_tissue},
            {"two needles", test_two_needles}, {"needles that meet", test_needles_that_meet},
            {"destruction in any order", test_destruction}, {"steps of the tissue between", test_tissue_steps_between},
            {"odd materials", test_odd_materials}, {"no friction", test_no_friction}, {"odd steps", test_odd_steps},
            {"substeps", test_substeps}, {"bad definitions", test_bad_definitions}, {"bad commands", test_bad_commands},
            {"too many needles", test_too_many_needles}, {"creation without memory", test_creation_without_memory},
            {"begins outside", test_begins_outside}, {"steps without memory", test_steps_without_memory},
            {"no memory for good", test_no_memory_for_good}, {"a step waits to be taken back", test_undo_waits},
            {"steps take no memory", test_steps_take_no_memory},
            {"needles that come and go", test_needles_that_come_and_go}, {"long random use", test_long_random_use},
            {"random scenes", test_random_scenes}, {"beside its path", test_beside_its_path});
