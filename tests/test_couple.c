/* couple: forces between needles and tissue: friction, sticking and slipping, membranes, balances, energy. */
#include "needle_scene.h"

/* A needle that hardly feels its tissue's inertia. */
static needle_scene slow_scene(void)
{
    needle_scene s = needle_scene_default();
    s.body_def.tolerance = REAL(scene_tolerance(1e-7, 100));
    s.body_def.max_iterations = 1000;
    return s;
}

static const double dt = 0.02, speed = 0.01;

/* ---- sliding ---- */

/* The needle goes in, and is then drawn back: friction along the depth, and what is cut on the way in. */
static void test_friction_per_length(void)
{
    needle_scene s = slow_scene();
    double f = (double)s.frictions[0].friction, cut = (double)s.frictions[0].cutting;
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 100, needle_command(speed, 0))) {
        for (int i = 0; i < 30; i++) { /* the depth at the start of a step is what the step feels */
            double depth = (double)ndl_needle_depth(s.needles[0]);
            needle_scene_run(&s, dt, 1, needle_command(speed, 0));
            CHECK_NEAR(needle_push(&s), f * depth + cut, 0.01 * (f * depth + cut));
            CHECK_INT(s.info.static_nodes, 0);
        }
        CHECK(ndl_needle_depth(s.needles[0]) > REAL(0.02));
        CHECK_NEAR(ndl_needle_cutting(s.needles[0]), cut, 1e-6 * cut);
        needle_scene_run(&s, dt, 25, needle_command(-speed, 0));
        for (int i = 0; i < 30; i++) {
            double depth = (double)ndl_needle_depth(s.needles[0]);
            needle_scene_run(&s, dt, 1, needle_command(-speed, 0));
            CHECK_NEAR(needle_push(&s), -f * depth, 0.01 * f * depth);
            CHECK(ndl_needle_advance(s.needles[0]) < 0);
        }
    }
    needle_scene_free(&s);
}

/* Two layers: each part of the depth feels its own friction, and the tip what it is in. */
static void test_friction_by_region(void)
{
    needle_scene s = slow_scene();
    double expected;
    s.layered = 1;
    s.frictions[1].friction = 60;
    s.frictions[1].cutting = 2;
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 160, needle_command(speed, 0))) {
        sb_vec3 tip;
        CHECK(ndl_needle_tip_material(s.needles[0], &tip));
        CHECK(tip.z < REAL(0.015));
        CHECK_NEAR(ndl_needle_cutting(s.needles[0]), 2, 1e-6);
        expected = 20 * 0.02 + 60 * (0.02 - (double)tip.z) + 2; /* of the undeformed layers */
        CHECK_NEAR(needle_push(&s), expected, 0.1 * expected);
    }
    needle_scene_free(&s);
}

/* Push at a steady speed, of a needle that only viscous friction holds. */
static double viscous_push(double along, double *depth)
{
    needle_scene s = slow_scene();
    double push = 0;
    s.frictions[0].friction = s.frictions[0].cutting = 0;
    s.frictions[0].viscous = 500;
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, (int)(0.02 / (dt * along) + 0.5), needle_command(along, 0))) {
        *depth = (double)ndl_needle_depth(s.needles[0]);
        needle_scene_run(&s, dt, 1, needle_command(along, 0));
        push = needle_push(&s);
        needle_scene_run(&s, dt, 200, needle_command(0, 0)); /* figure 7.4: held still, it feels nothing more */
        CHECK(fabs(needle_push(&s)) < 0.01 * push);
    }
    needle_scene_free(&s);
    return push;
}

static void test_viscous(void)
{
    double depth[2] = {1, 1}, slow = viscous_push(0.004, depth), fast = viscous_push(0.016, depth + 1);
    CHECK_NEAR(slow, 500 * 0.004 * depth[0], 0.02 * slow);
    CHECK_NEAR(fast, 500 * 0.016 * depth[1], 0.02 * fast);
}

/* ---- sticking ---- */

/* Moves the sleeve by `way` (m) in `steps` steps; writes place, push and depth after each. place[-1]: where it is. */
static void slide(needle_scene *s, double way, int steps, double *place, double *push, double *depth)
{
    ndl_command command = needle_command(0, 0);
    double at = place[-1];
    command.velocity = sb_v3(0, 0, REAL(-way / (steps * dt)));
    for (int i = 0; i < steps; i++) {
        needle_scene_run(s, dt, 1, command);
        at += way / steps;
        place[i] = at;
        push[i] = needle_push(s);
        depth[i] = (double)ndl_needle_depth(s->needles[0]);
    }
}

/* Area of the loop that a path closes (N m). */
static double loop_area(const double *place, const double *push, int count)
{
    double area = 0;
    for (int i = 0; i < count; i++) {
        int next = (i + 1) % count;
        area += 0.5 * (push[i] + push[next]) * (place[next] - place[i]);
    }
    return area;
}

/* To and fro: it sticks while less than the friction is needed, then slips at it, each way. */
static void test_stick_slip(void)
{
    enum { LEG = 40, LAST = 3 * LEG }; /* legs: out by 2 mm, then in and out by 4 mm, twice */
    needle_scene s = slow_scene();
    double place[5 * LEG + 1] = {0}, f[5 * LEG], depth[5 * LEG], *x = place + 1;
    s.frictions[0].cutting = 0;
    s.frictions[0].friction = 60;
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 120, needle_command(speed, 0))) {
        double limit = 60 * 0.023, loop, slope;
        int stuck = 0;
        for (int leg = 0; leg < 5; leg++)
            slide(&s,
                  leg == 0  ? -0.002
                  : leg % 2 ? 0.004
                            : -0.004,
                  LEG, x + leg * LEG, f + leg * LEG, depth + leg * LEG);
        for (int i = 0; i < 5 * LEG; i++)
            CHECK(fabs(f[i]) < 60 * depth[i] + 0.03 * limit);
        for (int leg = 1; leg < 5; leg++)
            CHECK_NEAR(f[leg * LEG + LEG - 1], (leg % 2 ? 60 : -60) * depth[leg * LEG + LEG - 1], 0.01 * limit);
        /* after a reversal it sticks: push and way are in proportion; once it slips the push hardly changes */
        slope = (f[LAST + 8] - f[LAST]) / (x[LAST + 8] - x[LAST]);
        CHECK_NEAR((f[LAST + 4] - f[LAST]) / (x[LAST + 4] - x[LAST]), slope, 0.1 * slope);
        CHECK(fabs((f[LAST + LEG - 1] - f[LAST + LEG - 9]) / (x[LAST + LEG - 1] - x[LAST + LEG - 9])) < 0.06 * slope);
        for (int i = LAST; i < LAST + LEG; i++)
            stuck += fabs(f[i]) < 0.8 * limit;
        CHECK(stuck > 5);
        for (int i = 0; i < LEG; i++) /* the second round is the first again */
            CHECK_NEAR(f[LAST + i], f[LEG + i], 0.05 * limit);
        loop = loop_area(x + 2 * LEG, f + 2 * LEG, 2 * LEG); /* rigid in rigid: 2 limits times the way */
        CHECK(loop > 0.5 * 2 * limit * 0.004 && loop < 2 * limit * 0.004);
    }
    needle_scene_free(&s);
}

/* Less than the friction: nothing slips, and the push comes back. */
static void test_sticks_below_the_limit(void)
{
    needle_scene s = slow_scene();
    double place[21] = {0}, push[21], depth[21];
    s.frictions[0].friction = 2000; /* 40 N at 2 cm */
    s.frictions[0].cutting = 0;
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 120, needle_command(speed, 0)) &&
        needle_scene_run(&s, dt, 50, needle_command(-0.002, 0))) {
        double advance = 0;
        needle_scene_run(&s, dt, 50, needle_command(0, 0));
        CHECK_INT(s.info.dynamic_nodes, 0);
        slide(&s, 1e-4, 10, place + 1, push + 1, depth);
        CHECK_INT(s.info.dynamic_nodes, 0);
        slide(&s, -1e-4, 10, place + 11, push + 11, depth);
        CHECK_INT(s.info.dynamic_nodes, 0);
        needle_scene_run(&s, dt, 100, needle_command(0, 0));
        advance = fabs((double)ndl_needle_advance(s.needles[0]));
        CHECK(advance == 0);
        CHECK(push[10] > push[1] + 0.01);
    }
    needle_scene_free(&s);
}

/* ---- membranes: figure 7.5 ---- */

/* Largest push while the tip is within `low` to `high` of the undeformed height, 0: it was not there. */
typedef struct push_record {
    double z[400], push[400];
    int count;
} push_record;

static double largest_push(const push_record *r, double low, double high)
{
    double most = 0;
    for (int i = 0; i < r->count; i++)
        if (r->z[i] >= low && r->z[i] < high)
            most = fmax(most, r->push[i]);
    return most;
}

static void test_membranes(void)
{
    static const ndl_membrane membranes[2] = {{{-1, 0}, 4, REAL(0.001)}, {{1, 0}, 3, REAL(0.001)}};
    static push_record r;
    needle_scene s = slow_scene();
    s.layered = 1;
    s.frictions[0].friction = s.frictions[1].friction = 5;
    s.frictions[0].cutting = s.frictions[1].cutting = REAL(0.2);
    s.needle_def.membranes = membranes;
    s.needle_def.membrane_count = 2;
    r.count = 0;
    if (needle_scene_make(&s)) {
        for (int i = 0; i < 200; i++) {
            sb_vec3 X = sb_v3(0, 0, REAL(0.05)); /* where the tip cuts in this step */
            ndl_needle_tip_material(s.needles[0], &X);
            if (!needle_scene_run(&s, dt, 1, needle_command(speed, 0)))
                break;
            r.z[r.count] = (double)X.z;
            r.push[r.count++] = needle_push(&s);
        }
        CHECK_NEAR(largest_push(&r, 0.0395, 0.0405), 4.2, 0.1);
        CHECK(largest_push(&r, 0.030, 0.0394) < 0.6); /* the drop after it */
        CHECK_NEAR(largest_push(&r, 0.0195, 0.0206), 3.3, 0.15);
        CHECK(largest_push(&r, 0.005, 0.019) < 0.6);
        CHECK(r.z[r.count - 1] < 0.012);
    }
    needle_scene_free(&s);
}

/* Before the skin breaks the tissue gives way, and comes back after it. */
static void test_puncture_dents(void)
{
    static const ndl_membrane skin = {{-1, 0}, 4, REAL(0.001)};
    needle_scene s = slow_scene();
    double deepest = 0, last = 0;
    s.frictions[0].friction = 5;
    s.frictions[0].cutting = REAL(0.2);
    s.needle_def.membranes = &skin;
    s.needle_def.membrane_count = 1;
    if (needle_scene_make(&s)) {
        for (int i = 0; i < 120; i++) {
            int entry;
            needle_scene_run(&s, dt, 1, needle_command(speed, 0));
            entry = ndl_needle_entry(s.needles[0]);
            if (entry >= ndl_rod_node_count(ndl_needle_rod(s.needles[0])))
                continue;
            last = 0.04 - (double)ndl_rod_positions(ndl_needle_rod(s.needles[0]))[entry].z;
            deepest = fmax(deepest, last);
        }
        CHECK(deepest > 0.001);
        CHECK(last < 0.4 * deepest);
    }
    needle_scene_free(&s);
}

static sb_real cut_by_height(void *user, sb_vec3 X, int region)
{
    int *calls = (int *)user;
    (*calls)++;
    if (region != 0)
        return SB_REAL_MAX;
    return X.z > REAL(0.03) ? 1 : X.z > REAL(0.02) ? 2 : -5;
}

/* A callback says what is to be cut, once per step; less than 0 is none. */
static void test_cutting_callback(void)
{
    needle_scene s = slow_scene();
    int calls = 0;
    s.frictions[0].friction = 0;
    s.frictions[0].cutting = 7;
    s.needle_def.cutting = cut_by_height;
    s.needle_def.cutting_user = &calls;
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 40, needle_command(speed, 0))) {
        int before = calls;
        CHECK_NEAR(needle_push(&s), 1, 0.02);
        needle_scene_run(&s, dt, 1, needle_command(speed, 0));
        CHECK_INT(calls - before, s.info.substeps);
        needle_scene_run(&s, dt, 49, needle_command(speed, 0));
        CHECK_NEAR(needle_push(&s), 2, 0.02);
        needle_scene_run(&s, dt, 60, needle_command(speed, 0));
        CHECK_NEAR(needle_push(&s), 0, 0.02);
    }
    needle_scene_free(&s);
}

/* ---- sideways: figure 7.6 ---- */

/* The sleeve swings to and fro while the needle goes in: the tissue goes with it, to the same side. */
static void test_lateral(void)
{
    needle_scene s = slow_scene();
    double most = 0, with = 0, against = 0;
    ndl_rod_section_preset(NDL_NITINOL_083, &s.needle_def.section);
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 75, needle_command(speed, 0))) {
        double aside = 0;
        int moved = 0;
        for (int i = 0; i < 100; i++) {
            ndl_command command = needle_command(0.002, 0);
            int entry = ndl_needle_entry(s.needles[0]), node = ndl_needle_body_node(s.needles[0], entry);
            command.velocity = sb_v3(REAL(0.008 * cos(0.1 * i)), 0, 0); /* by +-1.6 mm */
            needle_scene_run(&s, dt, 1, command);
            aside += 0.008 * cos(0.1 * i) * dt;
            if (node != ndl_needle_body_node(s.needles[0], ndl_needle_entry(s.needles[0])))
                continue;
            if (fabs(aside) > 4e-4) {
                double tissue = (double)sb_body_displacements(s.body)[node].x;
                moved++;
                with += tissue * aside > 0;
                against += tissue * aside < 0;
                most = fmax(most, fabs(tissue));
            }
        }
        CHECK(moved > 30);
        CHECK(with > 10 * against);
        CHECK(most > 1e-4 && most < 1e-3);
        CHECK(needle_drift(&s, s.needles[0]) < scene_tolerance(1e-6, 1000));
    }
    needle_scene_free(&s);
}

/* ---- drift and consistency ---- */

static void test_drift_and_consistency(void)
{
    needle_scene s = needle_scene_default();
    double drift = 0;
    int inconsistent = 0, steps = 0, coupled;
    ndl_rod_section_preset(NDL_NITINOL_083, &s.needle_def.section);
    s.needle_def.bevel.curvature = 8;
    if (needle_scene_make(&s))
        for (int i = 0; i < 300; i++) {
            ndl_command command = needle_command(i < 150 ? speed : i < 220 ? -speed : speed, i % 60 < 20 ? 4 : 0);
            command.velocity = sb_v3(REAL(0.004 * sin(0.1 * i)), REAL(0.004 * cos(0.07 * i)), 0);
            if (!needle_scene_run(&s, dt, 1, command))
                break;
            drift = fmax(drift, needle_drift(&s, s.needles[0]));
            CHECK(needle_drift(&s, s.needles[0]) >= 0);
            inconsistent += !s.info.consistent;
            steps++;
            coupled = 0;
            for (int k = 0; k < ndl_rod_node_count(ndl_needle_rod(s.needles[0])); k++)
                coupled += ndl_needle_body_node(s.needles[0], k) >= 0;
            CHECK_INT(s.info.static_nodes + s.info.dynamic_nodes, coupled);
        }
    CHECK(drift < scene_tolerance(1e-6, 1000));
    CHECK(inconsistent <= steps / 250);
    needle_scene_free(&s);
}

/* Along a chain of nodes at node i: between its edges, at the last one along its edge. */
static sb_vec3 chain_tangent(const sb_vec3 *x, int count, int i)
{
    sb_vec3 before = sb_v3_sub(x[i], x[i - 1]), after = i < count - 1 ? sb_v3_sub(x[i + 1], x[i]) : before, sum;
    sum = sb_v3_add(sb_v3_scale(1 / sb_v3_norm(before), before), sb_v3_scale(1 / sb_v3_norm(after), after));
    return sb_v3_scale(1 / sb_v3_norm(sum), sum);
}

/* Half the lengths of the edges of node i in the tissue. */
static double chain_share(const sb_vec3 *x, int count, int first, int i)
{
    double behind = i > first ? (double)sb_v3_norm(sb_v3_sub(x[i], x[i - 1])) : 0;
    double ahead = i < count - 1 ? (double)sb_v3_norm(sb_v3_sub(x[i + 1], x[i])) : 0;
    return 0.5 * (behind + ahead);
}

/* Whether what node i feels along the needle is what its state says. */
static void check_contact(const needle_scene *s, const sb_vec3 *before, int count, int i)
{
    double limit = 20 * chain_share(before, count, ndl_needle_entry(s->needles[0]), i);
    double forward = limit + (i == count - 1 ? 0.5 : 0), slack = scene_tolerance(0.01, 2e6) * forward + 1e-4;
    double along = (double)sb_v3_dot(chain_tangent(before, count, i), ndl_needle_contact_force(s->needles[0], i));
    switch (ndl_needle_contact(s->needles[0], i)) {
    case NDL_STATIC: CHECK(along >= -forward - slack && along <= limit + slack); break;
    case NDL_DYNAMIC_FORWARD: CHECK_NEAR(along, -forward, slack); break;
    case NDL_DYNAMIC_BACKWARD: CHECK_NEAR(along, limit, slack); break;
    default: CHECK(ndl_needle_contact(s->needles[0], i) != NDL_FREE);
    }
}

/* The tissue nodes of the needle but for the tip's; returns how many there are. */
static int list_path(const ndl_needle *needle, int *nodes)
{
    int n = ndl_rod_node_count(ndl_needle_rod(needle)), first = ndl_needle_entry(needle);
    for (int i = first; i < n - 1; i++)
        nodes[i - first] = ndl_needle_body_node(needle, i);
    return n - first - 1;
}

/* Every node that sticks is within its limit, every one that slips feels just it, against its slip. */
static void test_states_fit_forces(void)
{
    needle_scene s = slow_scene();
    sb_vec3 before[128];
    int nodes[2][128], sticks = 0, slips = 0;
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 110, needle_command(speed, 0)))
        for (int i = 0; i < 60; i++) {
            const ndl_rod *rod = ndl_needle_rod(s.needles[0]);
            int n = ndl_rod_node_count(rod), count = list_path(s.needles[0], nodes[0]);
            memcpy(before, ndl_rod_positions(rod), (size_t)n * sizeof *before);
            needle_scene_run(&s, dt, 1, needle_command(0.004 * (i % 20 - 10), 0));
            if (!s.info.consistent || s.info.substeps > 1 || n != ndl_rod_node_count(rod) ||
                count != list_path(s.needles[0], nodes[1]) ||
                memcmp(nodes[0], nodes[1], (size_t)count * sizeof(int)) != 0)
                continue;
            for (int k = ndl_needle_entry(s.needles[0]); k < n; k++)
                check_contact(&s, before, n, k);
            sticks += s.info.static_nodes;
            slips += s.info.dynamic_nodes;
        }
    CHECK(sticks > 10);
    CHECK(slips > 10);
    needle_scene_free(&s);
}

/* ---- balances ---- */

static sb_vec3 rod_momentum(const ndl_rod *rod)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int i = 0; i < ndl_rod_node_count(rod); i++)
        sum = sb_v3_madd(sum, ndl_rod_mass(rod, i), ndl_rod_velocities(rod)[i]);
    return sum;
}

static double rod_mass(const ndl_rod *rod)
{
    double sum = 0;
    for (int i = 0; i < ndl_rod_node_count(rod); i++)
        sum += (double)ndl_rod_mass(rod, i);
    return sum;
}

/* Base force, gravity and contact forces are the rate of the needle's momentum, in any motion that keeps its nodes. */
static void test_needle_balance(void)
{
    needle_scene s = slow_scene();
    int compared = 0;
    s.needle_def.gravity = sb_v3(REAL(1), REAL(-3), REAL(-9));
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 110, needle_command(speed, 0)))
        for (int i = 0; i < 60; i++) {
            const ndl_rod *rod = ndl_needle_rod(s.needles[0]);
            sb_vec3 before = rod_momentum(rod), force, rate, all;
            int n = ndl_rod_node_count(rod);
            ndl_command command = needle_command(0, 0);
            command.velocity =
                sb_v3(REAL(0.003 * sin(0.8 * i)), REAL(0.003 * cos(0.8 * i)), REAL(0.001 * cos(0.3 * i)));
            needle_scene_run(&s, 0.005, 1, command);
            if (s.info.operations || s.info.substeps > 1 || n != ndl_rod_node_count(rod))
                continue;
            ndl_needle_base_wrench(s.needles[0], &force, NULL);
            all = sb_v3_add(force, needle_contact_sum(s.needles[0]));
            all = sb_v3_madd(all, REAL(rod_mass(rod)), s.needle_def.gravity);
            rate = sb_v3_scale(REAL(200), sb_v3_sub(rod_momentum(rod), before));
            CHECK((double)sb_v3_norm(sb_v3_sub(all, rate)) <
                  scene_tolerance(1e-4, 3e5) * ((double)sb_v3_norm(force) + 0.01));
            compared++;
        }
    CHECK(compared > 20);
    needle_scene_free(&s);
}

/* At rest the supports of the tissue carry what the needle feels, and its sleeve the rest. */
static void test_static_balance(void)
{
    needle_scene s = slow_scene();
    s.needle_def.gravity = sb_v3(0, REAL(-9.81), 0);
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 110, needle_command(speed, 0))) {
        const ndl_rod *rod = ndl_needle_rod(s.needles[0]);
        ndl_command command = needle_command(0, 0);
        sb_vec3 reactions, contacts, force, torque, all, weight;
        command.velocity = sb_v3(REAL(0.01), 0, REAL(-0.005));
        needle_scene_run(&s, dt, 10, command);
        needle_scene_run(&s, dt, 300, needle_command(0, 0));
        reactions = scene_sum(sb_body_reactions(s.body), sb_body_node_count(s.body));
        contacts = needle_contact_sum(s.needles[0]);
        ndl_needle_base_wrench(s.needles[0], &force, &torque);
        weight = sb_v3_scale(REAL(rod_mass(rod)), s.needle_def.gravity);
        CHECK(sb_v3_norm(contacts) > REAL(0.05));
        CHECK(sb_v3_norm(sb_v3_sub(reactions, contacts)) < REAL(0.01) * sb_v3_norm(contacts));
        all = sb_v3_add(sb_v3_add(force, weight), contacts);
        CHECK(sb_v3_norm(all) < REAL(0.005) * sb_v3_norm(force));
        all = torque; /* moments about the outlet */
        for (int i = 0; i < ndl_rod_node_count(rod); i++) {
            sb_vec3 arm = sb_v3_sub(ndl_rod_positions(rod)[i], ndl_rod_positions(rod)[1]);
            sb_vec3 f = ndl_needle_contact_force(s.needles[0], i);
            f = sb_v3_madd(f, ndl_rod_mass(rod, i), s.needle_def.gravity);
            all = sb_v3_add(all, sb_v3_cross(arm, f));
        }
        CHECK(sb_v3_norm(all) < REAL(0.02) * sb_v3_norm(torque));
        CHECK(sb_v3_norm(torque) > REAL(1e-4));
    }
    needle_scene_free(&s);
}

/* ---- energy ---- */

static double whole_energy(const needle_scene *s)
{
    sb_energy body = {0, 0, 0};
    double sum;
    CHECK_OK(sb_body_energy(s->body, &body));
    sum = (double)body.elastic + (double)body.kinetic;
    for (int k = 0; k < s->count; k++) {
        ndl_rod_energy rod = ndl_rod_energies(ndl_needle_rod(s->needles[k]));
        sum += (double)rod.stretch + (double)rod.bend + (double)rod.twist + (double)rod.kinetic + (double)rod.grip;
    }
    return sum;
}

/* Let go at any moment, needle and tissue come to rest, without gaining energy; then nothing changes any more. */
static void rest_after(sb_integrator integrator, double damping, double step)
{
    needle_scene s = slow_scene();
    s.body_def.integrator = integrator;
    s.body_def.damping_stiffness = REAL(damping);
    ndl_rod_section_preset(NDL_NITINOL_083, &s.needle_def.section);
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 100, needle_command(2 * speed, 0))) {
        ndl_command command = needle_command(0, 0);
        double energy, most, quiet, worst = 0;
        sb_vec3 force, later;
        command.velocity = sb_v3(REAL(0.03), REAL(0.02), 0);
        needle_scene_run(&s, dt, 5, command);
        needle_scene_run(&s, step, 1, needle_command(0, 0)); /* the sleeve stops */
        energy = most = whole_energy(&s);
        for (int i = 0; i < 400; i++) {
            double now;
            needle_scene_run(&s, step, 1, needle_command(0, 0));
            now = whole_energy(&s);
            worst = fmax(worst, now - energy);
            most = fmax(most, now);
            energy = now;
        }
        CHECK(worst < 0.01 * most);
        ndl_needle_base_wrench(s.needles[0], &force, NULL);
        needle_scene_run(&s, step, 100, needle_command(0, 0));
        ndl_needle_base_wrench(s.needles[0], &later, NULL);
        quiet = whole_energy(&s);
        CHECK(quiet < energy + 0.002 * most);
        if (integrator != SB_NEWMARK) /* whose force goes on to ring, as needle.h says */
            CHECK(sb_v3_norm(sb_v3_sub(force, later)) < REAL(2e-3) * sb_v3_norm(force));
        CHECK_INT(s.info.operations, 0);
    }
    needle_scene_free(&s);
}

static void test_rest(void)
{
    rest_after(SB_GENERALISED_ALPHA, 0.005, 0.02);
    rest_after(SB_GENERALISED_ALPHA, 0, 0.01);
    rest_after(SB_EULER, 0, 0.01);
    rest_after(SB_NEWMARK, 0, 0.005);
}

/* ---- nothing hangs on steps, threads or place ---- */

typedef struct outcome {
    sb_vec3 tip;
    double push, depth;
} outcome;

static outcome insert_with(needle_scene s, double step, sb_vec3 aside)
{
    outcome out = {{0, 0, 0}, 0, 0};
    int third = (int)(1.0 / step + 0.5);
    if (needle_scene_make(&s)) {
        ndl_command command = needle_command(0, 0);
        command.velocity = s.turned ? needle_scene_turned(aside) : aside;
        needle_scene_run(&s, step, 2 * third, needle_command(speed, 0.5));
        needle_scene_run(&s, step, third / 5, command);
        needle_scene_run(&s, step, third / 10, needle_command(-speed, 0));
        out.tip = needle_tip(s.needles[0]);
        out.push = needle_push(&s);
        out.depth = (double)ndl_needle_depth(s.needles[0]);
    }
    needle_scene_free(&s);
    return out;
}

static void test_steps_do_not_matter(void)
{
    needle_scene s = slow_scene();
    outcome coarse, fine;
    ndl_rod_section_preset(NDL_NITINOL_083, &s.needle_def.section);
    coarse = insert_with(s, 0.02, sb_v3(REAL(0.002), 0, 0));
    fine = insert_with(s, 0.005, sb_v3(REAL(0.002), 0, 0));
    CHECK(sb_v3_norm(sb_v3_sub(coarse.tip, fine.tip)) < REAL(1e-4));
    CHECK_NEAR(coarse.push, fine.push, 0.03 * fabs(fine.push));
    CHECK_NEAR(coarse.depth, fine.depth, 2e-4);
}

static void test_place_does_not_matter(void)
{
    needle_scene s = slow_scene();
    outcome here, there;
    sb_vec3 expected;
    s.body_def.tolerance = REAL(scene_tolerance(1e-10, 100));
    s.needle_def.bevel.curvature = 5;
    here = insert_with(s, 0.02, sb_v3(REAL(0.005), 0, 0));
    s.turned = 1;
    there = insert_with(s, 0.02, sb_v3(REAL(0.005), 0, 0));
    expected = needle_scene_placed(here.tip);
    CHECK(sb_v3_norm(sb_v3_sub(expected, there.tip)) < REAL(scene_tolerance(1e-8, 3000)));
    CHECK_NEAR(there.push, here.push, scene_tolerance(1e-4, 3e5) * fabs(here.push));
    CHECK_NEAR(there.depth, here.depth, scene_tolerance(1e-8, 3000));
}

static unsigned long long bits_with(int workers)
{
    needle_scene s = needle_scene_default();
    unsigned long long bits = 0;
    if (workers > 0)
        s.body_def.jobs = scene_jobs(&workers);
    s.needle_def.bevel.curvature = 5;
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 80, needle_command(speed, 1)) &&
        needle_scene_run(&s, dt, 40, needle_command(-speed, 0)))
        bits = needle_scene_bits(&s);
    needle_scene_free(&s);
    return bits;
}

static void test_threads(void)
{
    unsigned long long one = bits_with(0);
    CHECK(one == bits_with(3));
    CHECK(one == bits_with(8));
    CHECK(one == bits_with(0));
}

CHECK_SUITE(couple, {"friction per length times depth", test_friction_per_length},
            {"friction by region", test_friction_by_region}, {"viscous friction grows with speed", test_viscous},
            {"sticks, then slips, with hysteresis", test_stick_slip},
            {"sticks below the limit", test_sticks_below_the_limit}, {"membranes: peak and drop", test_membranes},
            {"a puncture dents and lets go", test_puncture_dents}, {"cutting by a callback", test_cutting_callback},
            {"sideways", test_lateral}, {"no drift, states consistent", test_drift_and_consistency},
            {"states fit forces", test_states_fit_forces}, {"balance of the needle", test_needle_balance},
            {"balance at rest", test_static_balance}, {"rest without gain of energy", test_rest},
            {"steps do not matter", test_steps_do_not_matter}, {"place does not matter", test_place_does_not_matter},
            {"threads do not matter", test_threads});
