/* Rods that their surroundings grip against turning: closed forms of springs and of friction, hysteresis, energy,
 * what is carried along, failures. */
#include "check.h"
#include "needle.h"
#include "scene.h"

enum { MOST = 140 };

static const double length = 0.2;

static double torsion(void)
{
    ndl_rod_def def = ndl_default_rod_def();
    return (double)ndl_rod_stiffness_of(&def.section).twist;
}

/* A straight stylet whose edge 0 is the clamp, with `edges` more on 0.2 m; these are gripped by stiffness per length
 * (N m/rad/m) and limit per length (N). */
static ndl_rod *gripped(int edges, double stiffness, double limit)
{
    static sb_vec3 nodes[MOST];
    ndl_rod_def def = ndl_default_rod_def();
    ndl_rod *rod = NULL;
    double h = length / edges;
    for (int i = 0; i < edges + 2; i++)
        nodes[i] = sb_v3(REAL(h * (i - 1)), 0, 0);
    def.nodes = nodes;
    def.node_count = edges + 2;
    def.capacity = MOST;
    CHECK_OK(ndl_rod_create(&def, &rod, NULL));
    for (int j = 1; j < edges + 1; j++)
        CHECK_OK(ndl_rod_set_grip(rod, j, REAL(stiffness * h), REAL(limit * h)));
    return rod;
}

/* Turn of the edge's frame since it was along `before`. */
static double turned_from(const ndl_rod *rod, int edge, const ndl_frame *before)
{
    ndl_frame frame = ndl_rod_frame(rod, edge);
    return atan2((double)sb_v3_dot(sb_v3_cross(before->m1, frame.m1), frame.t),
                 (double)sb_v3_dot(before->m1, frame.m1));
}

static void turn_base(ndl_rod *rod, double angle, int by_steps)
{
    CHECK_OK(ndl_rod_turn(rod, 0, REAL(angle)));
    if (by_steps)
        CHECK_OK(ndl_rod_step(rod, REAL(0.01), NULL));
    else
        CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
}

/* theta'' = theta/lam^2 with a free tip: cosh((L - s)/lam)/cosh(L/lam) of the base's angle. */
static void test_elastic(void)
{
    double lam = 0.08, k = torsion() / (lam * lam), angle = 0.7, previous = 0;
    for (int edges = 16; edges <= 64; edges *= 2) {
        ndl_rod *rod = gripped(edges, k, 1e6);
        ndl_frame first = ndl_rod_frame(rod, 0);
        double worst = 0, torque = sqrt(torsion() * k) * tanh(length / lam) * angle;
        turn_base(rod, angle, edges == 32);
        for (int j = 1; j <= edges; j++) {
            double s = (j - 0.5) * length / edges;
            double expected = angle * cosh((length - s) / lam) / cosh(length / lam);
            worst = fmax(worst, fabs(turned_from(rod, j, &first) - expected) / angle);
            CHECK_NEAR((double)ndl_rod_grip_torque(rod, j), -k * length / edges * turned_from(rod, j, &first),
                       scene_tolerance(1e-12, 1e3));
        }
        CHECK_NEAR((double)ndl_rod_reaction_torque(rod, 0) / torque, 1, edges == 64 ? 5e-4 : 1e-2);
        if (previous != 0 && !SB_REAL_IS_FLOAT)
            CHECK_NEAR(previous / worst, 4, 0.5); /* second order */
        previous = worst;
        ndl_rod_destroy(rod);
    }
    CHECK(previous < 2e-4);
}

/* Friction m_t per length over L, with next to no elastic way before it: the tip stands still until the base has turned
 * by m_t L^2/(2 GJ), then all slips, and the base bears m_t L. */
static void test_friction(void)
{
    int edges = 40;
    for (int by_steps = 0; by_steps < 2; by_steps++) {
        double m = 0.02, yield = 1e-4, start = m * length * length / (2 * torsion()) + yield, moved = 0;
        ndl_rod *rod = gripped(edges, m / yield, m);
        ndl_frame tip = ndl_rod_frame(rod, edges), first = ndl_rod_frame(rod, 0);
        for (int step = 1; step <= 60; step++) {
            double base = 1.5 * start * step / 60, depth, torque;
            turn_base(rod, 1.5 * start / 60, by_steps);
            moved = turned_from(rod, edges, &tip);
            depth = fmin(length, sqrt(2 * torsion() * base / m)); /* how far in it slips */
            torque = (double)ndl_rod_reaction_torque(rod, 0);
            CHECK_NEAR(turned_from(rod, 0, &first), base, scene_tolerance(1e-12, 1e2));
            CHECK_NEAR(torque / (m * length), depth / length, 0.03);
            if (base < 0.95 * start)
                CHECK(moved < 0.5 * yield);
            if (base > 1.02 * start) {
                CHECK_NEAR(moved, base - (start - yield), 0.01 * start);
                CHECK_NEAR(torque / (m * length), 1, scene_tolerance(1e-9, 1e4));
            }
        }
        ndl_rod_destroy(rod);
    }
}

static double stored(const ndl_rod *rod)
{
    ndl_rod_energy e = ndl_rod_energies(rod);
    return (double)e.stretch + (double)e.bend + (double)e.twist + (double)e.kinetic + (double)e.grip;
}

/* Turned to and fro: the loop in base torque over angle closes after the first quarter, is as the rule of Masing has
 * it, and what the hand puts in is stored or has slipped. */
static void test_hysteresis(void)
{
    int edges = 40, quarter = 120;
    double m = 0.02, yield = 0.05, start = m * length * length / (2 * torsion()) + yield, most = 1.4 * start;
    double virgin[121], work = 0, slipped = 0, torques[5 * 120 + 1], first_stored;
    ndl_rod *rod = gripped(edges, m / yield, m);
    ndl_frame frames[MOST];
    torques[0] = virgin[0] = 0;
    first_stored = stored(rod);
    for (int step = 1; step <= 5 * quarter; step++) {
        int branch = (step - 1) / quarter; /* up, down twice, up twice */
        double angle = most / quarter * (branch == 0 || branch > 2 ? 1 : -1), before[MOST], torque;
        for (int j = 1; j <= edges; j++) {
            frames[j] = ndl_rod_frame(rod, j);
            before[j] = (double)ndl_rod_grip_torque(rod, j);
        }
        turn_base(rod, angle, 1);
        torque = (double)ndl_rod_reaction_torque(rod, 0);
        torques[step] = torque;
        for (int j = 1; j <= edges; j++) {
            double after = (double)ndl_rod_grip_torque(rod, j), h = length / edges;
            double way = turned_from(rod, j, &frames[j]), slip = way + (after - before[j]) / (m / yield * h);
            slipped += m * h * fabs(slip); /* at the limit while it slips */
            CHECK(fabs(after) <= m * h * (1 + scene_tolerance(1e-12, 100)));
        }
        work += 0.5 * (torques[step] + torques[step - 1]) * angle;
    }
    CHECK_NEAR((work - slipped - (stored(rod) - first_stored)) / work, 0, 2e-3); /* trapezia of the work */
    CHECK(slipped > 0.5 * work);
    CHECK_NEAR(torques[5 * quarter] / torques[quarter], 1, 1e-3);  /* the loop closes */
    CHECK_NEAR(torques[3 * quarter] / torques[quarter], -1, 1e-3); /* and is symmetric */
    for (int step = 1; step <= quarter / 2; step++) /* Masing: turned back it is the first branch at twice the scale */
        CHECK_NEAR((torques[quarter] - torques[quarter + 2 * step]) / (2 * torques[step]), 1, 0.01);
    ndl_rod_destroy(rod);
}

/* The same turn in one go or in a hundred: friction that only grows does not know how it was brought on. */
static void test_increments(void)
{
    double torques[3], tips[3];
    for (int way = 0; way < 3; way++) {
        int pieces = way == 0 ? 1 : way == 1 ? 100 : 7;
        ndl_rod *rod = gripped(30, 0.5, 0.02);
        ndl_frame tip = ndl_rod_frame(rod, 30);
        for (int k = 0; k < pieces; k++)
            turn_base(rod, 0.9 / pieces, way == 1);
        torques[way] = (double)ndl_rod_reaction_torque(rod, 0);
        tips[way] = turned_from(rod, 30, &tip);
        ndl_rod_destroy(rod);
    }
    for (int way = 1; way < 3; way++) {
        CHECK_NEAR(torques[way] / torques[0], 1, scene_tolerance(1e-9, 1e3));
        CHECK_NEAR(tips[way], tips[0], scene_tolerance(1e-9, 1e3));
    }
}

/* A needle bent at rest whose tip is gripped lies otherwise when its base is turned; forces are the energy's gradient
 * then, too. */
static void test_bent(void)
{
    sb_vec3 nodes[15], forces[15];
    ndl_rod_def def = ndl_default_rod_def();
    ndl_rod *rod = NULL;
    double h = SB_REAL_IS_FLOAT ? 1e-4 : 1e-7, worst = 0, largest = 0;
    for (int i = 0; i < 15; i++) {
        double s = length * i / 14;
        nodes[i] = sb_v3(REAL(s), REAL(2 * s * s), REAL(5 * s * s * s));
    }
    def.nodes = nodes;
    def.node_count = 15;
    def.rest = NDL_REST_SHAPE;
    CHECK_OK(ndl_rod_create(&def, &rod, NULL));
    for (int j = 6; j < 14; j++)
        CHECK_OK(ndl_rod_set_grip(rod, j, REAL(0.1), REAL(1e3)));
    CHECK_OK(ndl_rod_turn(rod, 0, 1));
    CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
    memcpy(nodes, ndl_rod_positions(rod), sizeof nodes);
    for (int i = 2; i < 15; i++) { /* away from equilibrium */
        nodes[i].y += REAL(1e-3 * sin(5.0 * i));
        nodes[i].z += REAL(1e-3 * cos(3.0 * i));
    }
    CHECK_OK(ndl_rod_set_positions(rod, nodes, NULL));
    ndl_rod_forces(rod, forces);
    for (int i = 2; i < 15; i++)
        for (int axis = 0; axis < 3; axis++) {
            sb_vec3 moved[15];
            double energy[2], found, force = (double)(&forces[i].x)[axis];
            for (int side = 0; side < 2; side++) {
                memcpy(moved, nodes, sizeof moved);
                (&moved[i].x)[axis] += REAL(side ? h : -h);
                CHECK_OK(ndl_rod_set_positions(rod, moved, NULL));
                energy[side] = stored(rod);
                CHECK_OK(ndl_rod_set_positions(rod, nodes, NULL));
            }
            found = -(energy[1] - energy[0]) / (2 * h);
            worst = fmax(worst, fabs(found - force));
            largest = fmax(largest, fabs(force));
        }
    CHECK_NEAR(worst / largest, 0, SB_REAL_IS_FLOAT ? 3e-2 : 1e-6);
    ndl_rod_destroy(rod);
}

/* Nothing holds the rod but its grip: turned by a torque it would be refused; wound springs hold it where it is. */
static void test_free_rod(void)
{
    sb_vec3 nodes[10];
    ndl_rod_def def = ndl_default_rod_def();
    ndl_rod *rod = NULL;
    ndl_frame frames[9];
    double sum = 0, back;
    for (int i = 0; i < 10; i++)
        nodes[i] = sb_v3(REAL(0.02 * i), 0, 0);
    def.nodes = nodes;
    def.node_count = 10;
    def.clamped = 0;
    CHECK_OK(ndl_rod_create(&def, &rod, NULL));
    for (int j = 4; j < 9; j++)
        CHECK_OK(ndl_rod_set_grip(rod, j, REAL(0.3), REAL(j == 8 ? 0.001 : 1)));
    CHECK_OK(ndl_rod_turn(rod, 0, REAL(0.5)));
    CHECK_OK(ndl_rod_step(rod, REAL(0.01), NULL));
    CHECK((double)ndl_rod_reaction_torque(rod, 0) > 0.05);
    for (int j = 0; j < 9; j++)
        frames[j] = ndl_rod_frame(rod, j);
    CHECK_OK(ndl_rod_release_turn(rod, 0));
    CHECK_OK(ndl_rod_step(rod, REAL(0.01), NULL)); /* springs unwind it, but for what has slipped at the tip */
    back = turned_from(rod, 0, &frames[0]);
    for (int j = 4; j < 9; j++)
        sum += (double)ndl_rod_grip_torque(rod, j);
    CHECK_NEAR(sum, 0, scene_tolerance(1e-10, 1e3));
    CHECK(back < -0.45 && back > -0.5 + 1e-5);
    CHECK((double)ndl_rod_grip_torque(rod, 8) > 1e-4);
    for (int j = 1; j < 9; j++)
        CHECK_NEAR(hypot((double)ndl_rod_frame(rod, j).t.y, (double)ndl_rod_frame(rod, j).t.z), 0,
                   scene_tolerance(1e-9, 1e3));
    ndl_rod_destroy(rod);
}

/* A change of grip: torque where it gets stiffer, winding where it gets softer, no more than the limit, nothing left of
 * one that is gone. */
static void test_changes(void)
{
    ndl_rod *rod = gripped(4, 0, 0);
    double torque;
    CHECK(ndl_rod_grip_torque(rod, 2) == 0);
    CHECK_OK(ndl_rod_set_grip(rod, 4, 2, 100));
    turn_base(rod, 0.01, 0);
    torque = (double)ndl_rod_grip_torque(rod, 4);
    CHECK(torque < -1e-3);
    CHECK_OK(ndl_rod_set_grip(rod, 4, 6, 100));
    CHECK_NEAR((double)ndl_rod_grip_torque(rod, 4) / torque, 1, scene_tolerance(1e-12, 10));
    CHECK_OK(ndl_rod_set_grip(rod, 4, 3, 100));
    CHECK_NEAR((double)ndl_rod_grip_torque(rod, 4) / torque, 0.5, scene_tolerance(1e-12, 10));
    CHECK_OK(ndl_rod_set_grip(rod, 4, 3, REAL(-0.25 * torque)));
    CHECK_NEAR((double)ndl_rod_grip_torque(rod, 4) / torque, 0.25, scene_tolerance(1e-12, 10));
    CHECK_OK(ndl_rod_set_grip(rod, 4, 3, 100)); /* what slipped has slipped */
    CHECK_NEAR((double)ndl_rod_grip_torque(rod, 4) / torque, 0.25, scene_tolerance(1e-12, 10));
    CHECK_OK(ndl_rod_set_grip(rod, 4, 0, 100));
    CHECK(ndl_rod_grip_torque(rod, 4) == 0);
    CHECK_OK(ndl_rod_set_grip(rod, 4, 3, 100));
    CHECK(ndl_rod_grip_torque(rod, 4) == 0);
    CHECK_OK(ndl_rod_set_grip(rod, 4, 3, 0)); /* slips at once: no grip */
    turn_base(rod, 0.3, 1);
    CHECK_NEAR((double)ndl_rod_reaction_torque(rod, 0), 0, scene_tolerance(1e-10, 1e3));
    ndl_rod_destroy(rod);
}

static double grip_sum(const ndl_rod *rod)
{
    double sum = 0;
    for (int j = 0; j < ndl_rod_node_count(rod) - 1; j++)
        sum += (double)ndl_rod_grip_torque(rod, j);
    return sum;
}

/* Other nodes, split edges, merged nodes: the torque of all springs stays, and what each is wound, about. */
static void test_carried(void)
{
    for (int slips = 0; slips < 2; slips++) {
        int edges = 40;
        double lam = 0.08, k = torsion() / (lam * lam), limit = slips ? 0.02 : 1e6, sum, torque, tip;
        ndl_rod *rod = gripped(edges, k, limit);
        ndl_frame last = ndl_rod_frame(rod, edges);
        sb_vec3 nodes[MOST];
        unsigned long long seed = 4;
        turn_base(rod, 0.9, 0);
        sum = grip_sum(rod);
        torque = (double)ndl_rod_reaction_torque(rod, 0);
        tip = turned_from(rod, edges, &last);
        CHECK_NEAR(-sum / torque, 1, scene_tolerance(1e-9, 1e3));
        for (int round = 0; round < 50; round++) {
            int n = 30 + (int)(40 * check_random(&seed));
            double h = length / (n - 2);
            for (int i = 0; i < n; i++)
                nodes[i] = sb_v3(REAL(i < 2 ? (i - 1) * length / edges
                                            : h * (i - 1 + (i < n - 1 ? check_random_in(&seed, -0.3, 0.3) : 0))),
                                 0, 0);
            CHECK_OK(ndl_rod_reparameterise(rod, nodes, n, NULL));
        }
        CHECK_NEAR(grip_sum(rod) / sum, 1, 5e-3);
        CHECK_NEAR(turned_from(rod, ndl_rod_node_count(rod) - 2, &last) / tip, 1, 0.02);
        CHECK_OK(ndl_rod_step(rod, REAL(0.01), NULL));
        CHECK_NEAR((double)ndl_rod_reaction_torque(rod, 0) / torque, 1, 5e-3);
        sum = grip_sum(rod);
        for (int k2 = 0; k2 < 5; k2++) {
            CHECK_OK(ndl_rod_split_edge(rod, 3 * k2 + 2));
            CHECK_NEAR(grip_sum(rod) / sum, 1, 5e-3); /* shorter edges twist a little otherwise */
        }
        for (int k2 = 0; k2 < 5; k2++) {
            CHECK_OK(ndl_rod_merge_node(rod, 2 * k2 + 3));
            CHECK_NEAR(grip_sum(rod) / sum, 1, 5e-3);
        }
        turn_base(rod, -0.9, 0); /* it can still unwind: all the way where nothing slipped */
        if (!slips)
            CHECK_NEAR((double)ndl_rod_reaction_torque(rod, 0) / torque, 0, 0.02);
        else
            CHECK((double)ndl_rod_reaction_torque(rod, 0) < -0.1 * torque);
        ndl_rod_destroy(rod);
    }
}

/* Steps that fail leave winding and slip as they were, to the last bit. */
static void test_undo(void)
{
    ndl_rod *rod = gripped(10, 0.5, 0.02), *twin = gripped(10, 0.5, 0.02);
    ndl_rod_static_options options = ndl_default_rod_static_options();
    ndl_rod_info info;
    sb_real before[11];
    turn_base(rod, 0.4, 1);
    turn_base(twin, 0.4, 1);
    for (int j = 0; j < 11; j++)
        before[j] = ndl_rod_grip_torque(rod, j);
    options.max_newton = 1;
    CHECK_OK(ndl_rod_turn(rod, 0, REAL(0.8)));
    CHECK_OK(ndl_rod_set_force(rod, 11, sb_v3(0, 50, 0)));
    CHECK_RESULT(ndl_rod_solve_static(rod, &options, &info), SB_ERROR_NOT_CONVERGED);
    for (int j = 0; j < 11; j++)
        CHECK(before[j] == ndl_rod_grip_torque(rod, j));
    CHECK_OK(ndl_rod_set_force(rod, 11, sb_v3(0, 0, 0)));
    CHECK_OK(ndl_rod_turn(rod, 0, REAL(-0.8))); /* it was still due */
    for (int s = 0; s < 3; s++) {
        CHECK_OK(ndl_rod_turn(rod, 0, REAL(-0.1)));
        CHECK_OK(ndl_rod_turn(twin, 0, REAL(-0.1)));
        CHECK_OK(ndl_rod_step(rod, REAL(0.01), NULL));
        CHECK_OK(ndl_rod_step(twin, REAL(0.01), NULL));
        for (int j = 0; j < 11; j++)
            CHECK(ndl_rod_grip_torque(twin, j) == ndl_rod_grip_torque(rod, j));
    }
    ndl_rod_destroy(rod);
    ndl_rod_destroy(twin);
}

/* n nodes about evenly along the rod's edges; the base and the tip stay. */
static void new_nodes(const ndl_rod *rod, sb_vec3 *nodes, int n, unsigned long long *seed)
{
    const sb_vec3 *x = ndl_rod_positions(rod);
    double whole = 0, passed = 0;
    int count = ndl_rod_node_count(rod), edge = 1;
    for (int i = 1; i < count - 1; i++)
        whole += (double)sb_v3_norm(sb_v3_sub(x[i + 1], x[i]));
    nodes[0] = x[0];
    nodes[1] = x[1];
    for (int i = 2; i < n - 1; i++) {
        double at = whole * (i - 1 + check_random_in(seed, -0.3, 0.3)) / (n - 2), size;
        while ((size = (double)sb_v3_norm(sb_v3_sub(x[edge + 1], x[edge]))) + passed < at && edge < count - 2) {
            passed += size;
            edge++;
        }
        nodes[i] = sb_v3_add(x[edge], sb_v3_scale(REAL((at - passed) / size), sb_v3_sub(x[edge + 1], x[edge])));
    }
    nodes[n - 1] = x[count - 1];
}

/* Grips, turns, pushes and nodes changed at random on a bent, flat wire: no torque beyond its limit, no step lost. */
static void test_violence(void)
{
    sb_vec3 nodes[MOST];
    unsigned long long seed = 21;
    ndl_rod_def def = ndl_default_rod_def();
    ndl_rod_stiffness stiffness = ndl_rod_stiffness_of(&def.section);
    ndl_rod *rod = NULL;
    int failed = 0, reshaped = 0;
    stiffness.bending[1] *= 3;
    for (int i = 0; i < 15; i++)
        nodes[i] = sb_v3(REAL(0.014 * i), REAL(8e-4 * i * i), REAL(4e-5 * i * i * i));
    def.nodes = nodes;
    def.node_count = 15;
    def.capacity = 40;
    def.stiffness = &stiffness;
    def.rest = NDL_REST_SHAPE;
    def.damping_stretch = REAL(1e-3);
    def.damping_bending = REAL(1e-2);
    CHECK_OK(ndl_rod_create(&def, &rod, NULL));
    for (int s = 0; s < (check_quick() ? 100 : 300); s++) {
        int n = ndl_rod_node_count(rod), edge = 1 + (int)((n - 2) * check_random(&seed));
        double limits[MOST];
        for (int j = 1; j < n - 1; j++) {
            limits[j] = check_random_in(&seed, 0, 2e-3);
            CHECK_OK(
                ndl_rod_set_grip(rod, j, REAL(s % 3 && j == edge ? 0 : check_random_in(&seed, 0, 1)), REAL(limits[j])));
        }
        CHECK_OK(ndl_rod_set_force(rod, n - 1, sb_v3(0, REAL(check_random_in(&seed, -1, 1)), 0)));
        CHECK_OK(ndl_rod_turn(rod, 0, REAL(check_random_in(&seed, -0.3, 0.3))));
        failed += ndl_rod_solve_static(rod, NULL, NULL) != SB_OK; /* turning a bent wire in steps feeds it energy */
        CHECK_OK(ndl_rod_turn(rod, 0, REAL(check_random_in(&seed, -0.3, 0.3))));
        failed += ndl_rod_step(rod, REAL(0.005), NULL) != SB_OK;
        for (int j = 1; j < n - 1; j++)
            CHECK(fabs((double)ndl_rod_grip_torque(rod, j)) <= limits[j] * (1 + scene_tolerance(1e-12, 100)));
        if (s % 5 == 0 && n < 38) {
            CHECK_OK(ndl_rod_split_edge(rod, edge));
        } else if (s % 5 == 1 && n > 8 && edge < n - 2) {
            sb_result result = ndl_rod_merge_node(rod, edge + 1); /* refused where the rod is bent by a right angle */
            CHECK(result == SB_OK || result == SB_ERROR_UNSUPPORTED);
        } else if (s % 5 == 2) {
            int m = 12 + (int)(20 * check_random(&seed));
            new_nodes(rod, nodes, m, &seed);
            CHECK_OK(ndl_rod_reparameterise(rod, nodes, m, NULL));
            reshaped++;
        }
        if (!CHECK(scene_all_finite(ndl_rod_positions(rod), ndl_rod_node_count(rod))))
            break;
    }
    CHECK_INT(failed, 0);
    CHECK(reshaped > 15);
    ndl_rod_destroy(rod);
}

static void test_refusals(void)
{
    ndl_rod *rod = gripped(4, 1, 1);
    ndl_frame first = ndl_rod_frame(rod, 1);
    double nothing = 0;
    CHECK_RESULT(ndl_rod_set_grip(NULL, 0, 1, 1), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_set_grip(rod, -1, 1, 1), SB_ERROR_INDEX);
    CHECK_RESULT(ndl_rod_set_grip(rod, 5, 1, 1), SB_ERROR_INDEX);
    check_bad_numbers();
    CHECK_RESULT(ndl_rod_set_grip(rod, 1, REAL(1 / nothing), 1), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(ndl_rod_set_grip(rod, 1, 1, REAL(nothing / nothing)), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(ndl_rod_set_grip(rod, 1, -1, 1), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_set_grip(rod, 1, 1, -1), SB_ERROR_ARGUMENT);
    turn_base(rod, 0.01, 0);
    CHECK_NEAR((double)ndl_rod_grip_torque(rod, 1) / (-length / 4 * turned_from(rod, 1, &first)), 1,
               scene_tolerance(1e-9, 1e4));
    ndl_rod_destroy(rod);
}

CHECK_SUITE(rod_grip, {"springs: cosh along the rod", test_elastic}, {"friction: when the tip starts", test_friction},
            {"to and fro: a closed loop, all work accounted for", test_hysteresis},
            {"in one go or in pieces", test_increments}, {"forces of a bent rod", test_bent},
            {"a rod that only its grip holds", test_free_rod}, {"changes of grip", test_changes},
            {"carried to other nodes", test_carried}, {"failures are undone", test_undo}, {"violence", test_violence},
            {"refusals", test_refusals});
