/* Rods: derivatives, closed forms in statics and dynamics, balances, changes of nodes, failures. */
#include "check.h"
#include "needle.h"
#include "scene.h"

enum { MOST = 128 };
static const double pi = 3.141592653589793;

/* n nodes along `direction` from the origin, `length` m in all. */
static void straight_nodes(sb_vec3 *nodes, int n, double length, sb_vec3 direction)
{
    direction = sb_v3_scale(1 / sb_v3_norm(direction), direction);
    for (int i = 0; i < n; i++)
        nodes[i] = sb_v3_scale(REAL(length * i / (n - 1)), direction);
}

static ndl_rod *make_rod(const ndl_rod_def *def)
{
    ndl_rod *rod = NULL;
    sb_error error;
    if (ndl_rod_create(def, &rod, &error) != SB_OK) {
        printf("%s: %s\n", sb_result_string(error.result), error.message);
        CHECK(rod != NULL);
    }
    return rod;
}

static double norm(sb_vec3 v) { return (double)sb_v3_norm(v); }

static double elastic(const ndl_rod *rod)
{
    ndl_rod_energy e = ndl_rod_energies(rod);
    return (double)e.stretch + (double)e.bend + (double)e.twist;
}

static double total(const ndl_rod *rod) { return elastic(rod) + (double)ndl_rod_energies(rod).kinetic; }

/* A rod of moderate stiffness ratios, so that every energy shows: shaken shape, curved at rest. */
static ndl_rod *shaken_rod(int anisotropic, int curved, int n, sb_vec3 *nodes)
{
    static sb_real curvature[2 * MOST];
    unsigned long long seed = 5;
    ndl_rod_def def = ndl_default_rod_def();
    ndl_rod_stiffness stiffness;
    stiffness.stretch = 100;
    stiffness.bending[0] = 1;
    stiffness.bending[1] = anisotropic ? REAL(2.5) : 1;
    stiffness.twist = REAL(0.7);
    stiffness.line_density = 1;
    straight_nodes(nodes, n, 0.1 * (n - 1), sb_v3(1, REAL(0.3), REAL(-0.2)));
    for (int i = 0; i < n; i++) {
        nodes[i] = sb_v3_add(nodes[i],
                             sb_v3(REAL(check_random_in(&seed, -0.03, 0.03)), REAL(check_random_in(&seed, -0.03, 0.03)),
                                   REAL(check_random_in(&seed, -0.03, 0.03))));
        curvature[2 * i] = REAL(check_random_in(&seed, -4, 4));
        curvature[2 * i + 1] = REAL(check_random_in(&seed, -4, 4));
    }
    def.nodes = nodes;
    def.node_count = n;
    def.stiffness = &stiffness;
    def.rest = curved ? NDL_REST_CURVATURE : NDL_REST_STRAIGHT;
    def.rest_curvature = curvature;
    return make_rod(&def);
}

static sb_real *axis_of(sb_vec3 *v, int axis) { return axis == 0 ? &v->x : axis == 1 ? &v->y : &v->z; }

/* Forces are minus the differences of the energy, frames eliminated: also with a tip that is held against turning. */
static void test_gradients(void)
{
    for (int kind = 0; kind < 4; kind++) {
        sb_vec3 nodes[9], forces[9];
        int n = 9;
        ndl_rod *rod = shaken_rod(kind == 2, kind == 1 || kind == 2, n, nodes);
        double h = SB_REAL_IS_FLOAT ? 1e-2 : 2e-6, worst = 0, largest = 0;
        for (int i = 0; i < n && kind == 3; i++) /* with both ends held the twist's work is a function of the shape */
            if (i < 2 || i > n - 3)
                CHECK_OK(ndl_rod_hold(rod, i, nodes[i], NULL));
        if (kind == 3)
            CHECK_OK(ndl_rod_turn(rod, n - 2, REAL(1.5)));
        CHECK_OK(ndl_rod_set_positions(rod, nodes, NULL));
        ndl_rod_forces(rod, forces);
        for (int i = 0; i < n; i++)
            for (int axis = 0; axis < 3; axis++) {
                sb_vec3 moved[9];
                double energy[2], apart;
                sb_real ends[2];
                for (int side = 0; side < 2; side++) {
                    memcpy(moved, nodes, sizeof moved);
                    *axis_of(&moved[i], axis) += REAL(side ? h : -h);
                    ends[side] = *axis_of(&moved[i], axis);
                    CHECK_OK(ndl_rod_set_positions(rod, moved, NULL));
                    energy[side] = elastic(rod);
                    CHECK_OK(ndl_rod_set_positions(rod, nodes, NULL));
                }
                apart = (double)ends[1] - (double)ends[0];
                worst = fmax(worst, fabs((energy[1] - energy[0]) / apart + (double)*axis_of(&forces[i], axis)));
                largest = fmax(largest, norm(forces[i]));
            }
        CHECK_NEAR(worst / largest, 0, SB_REAL_IS_FLOAT ? 3e-2 : 1e-6);
        ndl_rod_destroy(rod);
    }
}

/* ---- statics against closed forms ---- */

/* A clamped stylet; free edges + 1 edges, the first in the clamp. */
static ndl_rod *cantilever(int free_edges, double length, sb_vec3 direction, double scale)
{
    static sb_vec3 nodes[MOST];
    ndl_rod_def def = ndl_default_rod_def();
    double lb = length / free_edges;
    straight_nodes(nodes, free_edges + 2, length + lb, direction);
    def.nodes = nodes;
    def.node_count = free_edges + 2;
    def.section.radius *= REAL(scale);
    return make_rod(&def);
}

static double stylet_bending(void)
{
    ndl_rod_section section;
    CHECK_OK(ndl_rod_section_preset(NDL_STYLET_18G, &section));
    return (double)ndl_rod_stiffness_of(&section).bending[0];
}

static void test_small_deflection(void)
{
    double length = 0.2, ei = stylet_bending(), delta = 1e-3 * length,
           load = 3 * ei * delta / (length * length * length);
    double previous = 0;
    for (int edges = 10; edges <= 40; edges *= 2) {
        ndl_rod *rod = cantilever(edges, length, sb_v3(1, 0, 0), 1);
        double error;
        sb_vec3 force, torque;
        CHECK_OK(ndl_rod_set_force(rod, edges + 1, sb_v3(0, REAL(load), 0)));
        CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
        error = (double)ndl_rod_positions(rod)[edges + 1].y / delta - 1;
        if (edges == 40)
            CHECK_NEAR(error, 0, 1e-3);
        if (previous != 0)
            CHECK_NEAR(previous / error, 4, SB_REAL_IS_FLOAT ? 0.5 : 0.2); /* second order */
        previous = error;
        ndl_rod_base_wrench(rod, &force, &torque);
        CHECK_NEAR(norm(sb_v3_add(force, sb_v3(0, REAL(load), 0))) / load, 0, scene_tolerance(1e-6, 1e3));
        CHECK_NEAR((double)torque.z / (-load * (length + length / edges)), 1, scene_tolerance(1e-5, 1e3));
        ndl_rod_destroy(rod);
    }
}

static void test_elastica(void)
{
    static const double table[8][4] = {{0.25, 0.08275, 0.00412, 0.12429}, {0.5, 0.16214, 0.01592, 0.24453},
                                       {1, 0.30172, 0.05643, 0.46135},    {2, 0.49346, 0.16064, 0.78175},
                                       {3, 0.60325, 0.25442, 0.98602},    {5, 0.71379, 0.38763, 1.21537},
                                       {7.5, 0.77670, 0.48957, 1.35593},  {10, 0.81061, 0.55500, 1.43029}};
    double length = 0.2, ei = stylet_bending();
    ndl_rod *rod = cantilever(40, length, sb_v3(1, 0, 0), 1);
    for (int k = 0; k < 8; k++) {
        ndl_rod_info info;
        sb_vec3 tip;
        ndl_frame frame;
        double load = table[k][0] * ei / (length * length);
        CHECK_OK(ndl_rod_set_force(rod, 41, sb_v3(0, REAL(load), 0)));
        CHECK_OK(ndl_rod_solve_static(rod, NULL, &info));
        ndl_rod_tip(rod, &tip, &frame);
        CHECK_NEAR((double)tip.y / length, table[k][1], 0.005 * table[k][1]);
        CHECK_NEAR(1.025 - (double)tip.x / length, table[k][2], 0.005 * table[k][2] + 1e-5);
        CHECK_NEAR(atan2((double)frame.t.y, (double)frame.t.x), table[k][3], 0.005 * table[k][3]);
        CHECK(info.newton_iterations < 100);
    }
    ndl_rod_destroy(rod);
}

/* ---- pressed ---- */

/* How far (m) the tip of a cantilever goes aside that is pressed by `share` of Euler's load and pushed aside by so much
 * of it. */
static double pressed_aside(int edges, double length, double share, double push, int *iterations)
{
    ndl_rod *rod = cantilever(edges, length, sb_v3(0, 0, 1), 1);
    double euler = pi * pi * stylet_bending() / (4 * length * length), aside;
    ndl_rod_info info;
    CHECK_OK(ndl_rod_set_force(rod, edges + 1, sb_v3(REAL(push * euler), 0, REAL(-share * euler))));
    CHECK_OK(ndl_rod_solve_static(rod, NULL, &info));
    aside = (double)ndl_rod_positions(rod)[edges + 1].x;
    *iterations = info.newton_iterations;
    ndl_rod_destroy(rod);
    return aside;
}

/* The tip of the elastica beyond Euler's load: K(k) = pi/2 sqrt(share), aside 2 k / sqrt(P/EI). K by the mean of
 * Gauss. */
static double elastica_aside(double length, double share)
{
    double low = 0, high = 1;
    for (int halving = 0; halving < 60; halving++) {
        double k = (low + high) / 2, a = 1, b = sqrt(1 - k * k);
        for (int round = 0; round < 12; round++) {
            double mean = (a + b) / 2;
            b = sqrt(a * b);
            a = mean;
        }
        if (pi / (2 * a) < pi / 2 * sqrt(share))
            low = k;
        else
            high = k;
    }
    return 2 * low * 2 * length / (pi * sqrt(share));
}

/* About Euler's load a rod gives way to next to nothing, and is found there at once, from 10 to 90 edges; beyond it
 * the tip goes as far as the elastica's. */
static void test_buckling_load(void)
{
    static const double near[5] = {0.99, 0.999, 1, 1.001, 1.01}, pushes[3] = {1e-7, 1e-5, 1e-3},
                        beyond[3] = {1.1, 1.5, 3};
    const double length = 0.2;
    int most = 0, most_beyond = 0, iterations;
    for (int edges = 10; edges <= 90; edges *= 3)
        for (int p = 0; p < 3; p++) {
            double last = 0;
            for (int k = 0; k < 5; k++) {
                double aside = pressed_aside(edges, length, near[k], pushes[p], &iterations);
                CHECK(aside > last);
                last = aside;
                if (near[k] < 1.005)
                    most = iterations > most ? iterations : most;
                else
                    most_beyond = iterations > most_beyond ? iterations : most_beyond;
            }
        }
    for (int k = 0; k < 3; k++) {
        double expected = elastica_aside(length, beyond[k]);
        CHECK_NEAR(pressed_aside(40, length, beyond[k], 1e-5, &iterations), expected, 0.02 * expected);
        most_beyond = iterations > most_beyond ? iterations : most_beyond;
    }
    printf("  at most %d iterations at Euler's load, %d beyond\n", most, most_beyond);
    CHECK(most <= 50 && most_beyond <= 150);
}

/* ---- twist ---- */

/* Both ends clamped, m nodes; the tip turned so that the torque is `moment`. */
static ndl_rod *twisted(int free_edges, double length, double moment)
{
    static sb_vec3 nodes[MOST];
    ndl_rod_def def = ndl_default_rod_def();
    int n = free_edges + 3;
    ndl_rod *rod;
    straight_nodes(nodes, n, length * (free_edges + 2) / free_edges, sb_v3(0, 0, 1));
    def.nodes = nodes;
    def.node_count = n;
    rod = make_rod(&def);
    for (int i = n - 2; i < n; i++)
        CHECK_OK(ndl_rod_hold(rod, i, nodes[i], NULL));
    CHECK_OK(ndl_rod_turn(rod, n - 2, REAL(moment * length / (double)ndl_rod_stiffness_of(&def.section).twist)));
    return rod;
}

/* Stiffness of the middle against a small push. */
static double push_stiffness(int free_edges, double length, double moment)
{
    ndl_rod *rod = twisted(free_edges, length, moment);
    int middle = (free_edges + 3) / 2;
    double push = 1e-6 * stylet_bending() / (length * length), moved;
    CHECK_OK(ndl_rod_set_force(rod, middle, sb_v3(REAL(push), 0, 0)));
    CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
    CHECK_NEAR((double)ndl_rod_reaction_torque(rod, free_edges + 1) / moment, 1, scene_tolerance(1e-6, 100));
    CHECK_NEAR((double)ndl_rod_reaction_torque(rod, 0) / moment, -1, scene_tolerance(1e-6, 100));
    moved = (double)ndl_rod_positions(rod)[middle].x;
    ndl_rod_destroy(rod);
    return push / moved;
}

/* A twisted straight rod between clamps gives way where tan z = z, M = 2 z EI/L (Greenhill 1883). */
static void test_greenhill(void)
{
    double length = 0.2, critical = 8.98682 * stylet_bending() / length;
    double low = push_stiffness(39, length, 0.96 * critical), high = push_stiffness(39, length, 0.98 * critical);
    double found = 0.98 + 0.02 * high / (low - high);
    CHECK_NEAR(found, 1, 0.01);
    CHECK(push_stiffness(39, length, 0.5 * critical) > 10 * high);
}

/* Beyond it, the rod buckles far when pushed a little, and its energy falls. */
static void test_post_buckling(void)
{
    double length = 0.2, critical = 8.98682 * stylet_bending() / length, straight;
    ndl_rod *rod = twisted(39, length, 1.3 * critical);
    ndl_rod_info info;
    CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
    straight = elastic(rod);
    CHECK_OK(ndl_rod_hold(rod, 40, sb_v3(0, 0, REAL(length * 40 / 39 * 0.98)), NULL)); /* lets the ends come together */
    CHECK_OK(ndl_rod_hold(rod, 41, sb_v3(0, 0, REAL(length * (40 / 39.0 * 0.98 + 1 / 39.0))), NULL));
    CHECK_OK(ndl_rod_set_force(rod, 20, sb_v3(REAL(1e-3 * stylet_bending() / (length * length)), 0, 0)));
    CHECK_OK(ndl_rod_solve_static(rod, NULL, &info));
    CHECK(norm(sb_v3_sub(ndl_rod_positions(rod)[20], sb_v3(0, 0, ndl_rod_positions(rod)[20].z))) > 0.02 * length);
    CHECK(elastic(rod) < straight);
    ndl_rod_destroy(rod);
}

/* With a free tip the whole needle turns with its base, straight or bent, and no twist is left. */
static void test_free_tip_turns(void)
{
    for (int bent = 0; bent < 2; bent++) {
        ndl_rod *rod = cantilever(12, 0.2, sb_v3(1, 0, 0), 1);
        ndl_frame before, after;
        double angle;
        CHECK_OK(ndl_rod_set_force(rod, 13, sb_v3(0, REAL(bent ? 0.5 : 0), 0)));
        CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
        ndl_rod_tip(rod, NULL, &before);
        for (int s = 0; s < 20; s++) {
            CHECK_OK(ndl_rod_turn(rod, 0, REAL(0.05)));
            CHECK_OK(ndl_rod_step(rod, REAL(0.01), NULL));
        }
        ndl_rod_tip(rod, NULL, &after);
        angle =
            atan2((double)sb_v3_dot(sb_v3_cross(before.m1, after.m1), after.t), (double)sb_v3_dot(before.m1, after.m1));
        CHECK_NEAR(angle, 1, scene_tolerance(1e-6, 1e3));
        CHECK_NEAR((double)ndl_rod_energies(rod).twist / (elastic(rod) + 1e-12), 0, 1e-9);
        for (int i = 1; i < 13; i++)
            CHECK_NEAR(ndl_rod_twist(rod, i), 0, scene_tolerance(1e-9, 10));
        ndl_rod_destroy(rod);
    }
}

/* A torque at the tip twists a straight rod by T L/GJ; a quarter circle that is loaded at its tip out of its plane is
 * bent and twisted: v = P R^3 (pi/4 /EI + (3 pi/4 - 2)/GJ) (Castigliano). */
static void test_torsion(void)
{
    double radius = 0.1, ei = stylet_bending(), gj, load = 1e-3 * ei / (radius * radius), expected;
    ndl_rod_def def = ndl_default_rod_def();
    sb_vec3 nodes[82];
    ndl_rod *rod = cantilever(20, 0.2, sb_v3(1, 2, 3), 1);
    double turned = 0;
    gj = (double)ndl_rod_stiffness_of(&def.section).twist;
    CHECK_OK(ndl_rod_set_torque(rod, 20, REAL(0.3 * gj / 0.2)));
    CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
    for (int i = 1; i < 21; i++)
        turned += (double)ndl_rod_twist(rod, i);
    CHECK_NEAR(turned, 0.3 * (1 - 0.5 / 20), 1e-6); /* up to the middle of the last edge */
    ndl_rod_destroy(rod);
    for (int i = 0; i < 82; i++) {
        double angle = (i - 1) / 80.0 * pi / 2;
        nodes[i] = sb_v3(REAL(radius * sin(angle)), REAL(radius * (1 - cos(angle))), 0);
    }
    nodes[0] = sb_v3(REAL(-radius * pi / 160), 0, 0);
    def.nodes = nodes;
    def.node_count = 82;
    def.rest = NDL_REST_SHAPE;
    rod = make_rod(&def);
    CHECK_NEAR(elastic(rod), 0, 1e-15);
    CHECK_OK(ndl_rod_set_force(rod, 81, sb_v3(0, 0, REAL(load))));
    CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
    expected = load * radius * radius * radius * (pi / 4 / ei + (3 * pi / 4 - 2) / gj);
    CHECK_NEAR((double)ndl_rod_positions(rod)[81].z / expected, 1, 0.003);
    ndl_rod_destroy(rod);
}

/* ---- dynamics ---- */

static void test_frequency(void)
{
    double length = 0.2, omega, period, crossings[2] = {0, 0}, before = 1, time = 0;
    ndl_rod_section section;
    ndl_rod_stiffness k;
    ndl_rod *rod = cantilever(40, length, sb_v3(1, 0, 0), 1);
    int count = 0, steps = 0;
    CHECK_OK(ndl_rod_section_preset(NDL_STYLET_18G, &section));
    k = ndl_rod_stiffness_of(&section);
    omega = 1.87510407 * 1.87510407 * sqrt((double)k.bending[0] / ((double)k.line_density * pow(length, 4)));
    period = 2 * pi / omega;
    CHECK_OK(ndl_rod_set_damping(rod, 0, 0));
    CHECK_OK(ndl_rod_set_force(rod, 41, sb_v3(0, REAL(0.03 * stylet_bending() / (length * length)), 0)));
    CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
    CHECK_OK(ndl_rod_set_force(rod, 41, sb_v3(0, 0, 0)));
    for (; count < 21 && steps < 3000; steps++) { /* zeros of the tip's deflection are half a period apart */
        double dt = period / 200, now;
        ndl_rod_info info;
        CHECK_OK(ndl_rod_step(rod, REAL(dt), &info));
        CHECK_INT(info.damped, 0);
        now = (double)ndl_rod_positions(rod)[41].y;
        time += dt;
        if ((now < 0) != (before < 0) && steps > 0) {
            if (count == 0 || count == 20)
                crossings[count == 20] = time - dt * now / (now - before);
            count++;
        }
        before = now;
    }
    CHECK_NEAR(10 * period / (crossings[1] - crossings[0]), 1, 0.01);
    ndl_rod_destroy(rod);
}

static void sums(const ndl_rod *rod, double linear[3], double angular[3], double *scale)
{
    for (int k = 0; k < 3; k++)
        linear[k] = angular[k] = 0;
    *scale = 0;
    for (int i = 0; i < ndl_rod_node_count(rod); i++) {
        double m = (double)ndl_rod_mass(rod, i), x[3], v[3];
        x[0] = (double)ndl_rod_positions(rod)[i].x, x[1] = (double)ndl_rod_positions(rod)[i].y;
        x[2] = (double)ndl_rod_positions(rod)[i].z, v[0] = (double)ndl_rod_velocities(rod)[i].x;
        v[1] = (double)ndl_rod_velocities(rod)[i].y, v[2] = (double)ndl_rod_velocities(rod)[i].z;
        for (int k = 0; k < 3; k++) {
            linear[k] += m * v[k];
            angular[k] += m * (x[(k + 1) % 3] * v[(k + 2) % 3] - x[(k + 2) % 3] * v[(k + 1) % 3]);
            *scale += m * fabs(v[k]);
        }
    }
}

/* A free rod that was bent, let go and thrown, with and without damping. */
static void test_momentum(void)
{
    for (int damped = 0; damped < 2; damped++) {
        sb_vec3 nodes[21], velocities[21];
        ndl_rod_def def = ndl_default_rod_def();
        ndl_rod *rod;
        unsigned long long seed = 3;
        double before[3], turn_before[3], after[3], turn_after[3], scale, worst = 0, turned = 0, first;
        for (int i = 0; i < 21; i++) {
            double s = 0.01 * i;
            nodes[i] = sb_v3(REAL(0.05 * sin(s / 0.05)), REAL(0.05 * (1 - cos(s / 0.05))), REAL(0.1 * s));
            velocities[i] = sb_v3(REAL(1 + 0.3 * check_random_in(&seed, -1, 1)), REAL(20 * s), REAL(0.5 - 10 * s));
        }
        def.nodes = nodes;
        def.node_count = 21;
        def.clamped = 0;
        def.damping_stretch = def.damping_bending = REAL(damped ? 1e-4 : 0);
        rod = make_rod(&def);
        CHECK_OK(ndl_rod_set_velocities(rod, velocities));
        sums(rod, before, turn_before, &scale);
        first = total(rod);
        for (int s = 0; s < 500; s++) {
            CHECK_OK(ndl_rod_step(rod, REAL(2e-5), NULL));
            sums(rod, after, turn_after, &scale);
            for (int k = 0; k < 3; k++) {
                worst = fmax(worst, fabs(after[k] - before[k]) / scale);
                turned = fmax(turned, fabs(turn_after[k] - turn_before[k]) / (0.1 * scale));
            }
            CHECK(total(rod) < 1.01 * first);
        }
        CHECK_NEAR(worst, 0, scene_tolerance(1e-12, 10));
        if (!damped)
            CHECK_NEAR(turned, 0, 2e-3);
        ndl_rod_destroy(rod);
    }
}

/* No step, however long, gains energy: a strongly bent rod, clamped or free, let go without damping. */
static void test_energy(void)
{
    for (int kind = 0; kind < 6; kind++) {
        static const double steps_of[3] = {1e-4, 2e-3, 2e-2};
        sb_vec3 nodes[21];
        ndl_rod_def def = ndl_default_rod_def();
        ndl_rod *rod;
        double first, most = 0;
        int damped = 0;
        for (int i = 0; i < 21; i++) {
            double s = 0.01 * i / 0.06;
            nodes[i] = sb_v3(REAL(0.06 * sin(s)), REAL(0.06 * (1 - cos(s))), 0);
        }
        def.nodes = nodes;
        def.node_count = 21;
        def.clamped = kind < 3;
        def.damping_stretch = def.damping_bending = 0;
        def.gravity = sb_v3(0, 0, REAL(kind < 3 ? -9.81 : 0));
        rod = make_rod(&def);
        first = total(rod);
        for (int s = 0; s < (check_quick() ? 200 : 1000); s++) {
            ndl_rod_info info;
            if (!CHECK_OK(ndl_rod_step(rod, REAL(steps_of[kind % 3]), &info)))
                break;
            damped += info.damped;
            most = fmax(most, total(rod));
        }
        CHECK(most < 1.02 * first);
        CHECK(kind % 3 != 0 || damped < 100); /* short steps hardly need it */
        ndl_rod_destroy(rod);
    }
}

/* One linear system a step: the same motion where it is slow, and stable where it is not. */
static void test_linearised(void)
{
    sb_vec3 nodes[12], tips[2];
    ndl_rod_def def = ndl_default_rod_def();
    straight_nodes(nodes, 12, 0.22, sb_v3(0, 1, 0));
    def.nodes = nodes;
    def.node_count = 12;
    def.damping_bending = REAL(2e-3);
    for (int b = 0; b < 2; b++) {
        ndl_rod *rod;
        def.max_newton = b ? 1 : 30;
        rod = make_rod(&def);
        for (int s = 1; s <= 200; s++) {
            ndl_rod_info info;
            sb_vec3 t = sb_v3(REAL(sin(0.002 * s)), REAL(cos(0.002 * s)), 0);
            CHECK_OK(ndl_rod_hold_base(rod, sb_v3(0, 0, 0), t, sb_v3(0, 0, 1), NULL, NULL));
            CHECK_OK(ndl_rod_set_force(rod, 11, sb_v3(0, 0, REAL(0.002 * s))));
            CHECK_OK(ndl_rod_step(rod, REAL(0.01), &info));
            CHECK(b == 0 || info.newton_iterations == 1);
        }
        ndl_rod_tip(rod, &tips[b], NULL);
        for (int s = 1; s <= 200; s++) { /* pushed about */
            CHECK_OK(ndl_rod_set_force(rod, 11, sb_v3(REAL(3 * sin(0.7 * s)), 0, REAL(3 * cos(1.1 * s)))));
            CHECK_OK(ndl_rod_step(rod, REAL(0.01), NULL));
            CHECK(norm(ndl_rod_positions(rod)[11]) < (b ? 0.5 : 0.25)); /* what turns in a line gets longer */
        }
        ndl_rod_destroy(rod);
    }
    CHECK_NEAR(norm(sb_v3_sub(tips[0], tips[1])), 0, 2e-4);
}

/* A pre-bent needle, straightened and turned, comes to rest in its rest shape. */
static void test_prebent_rests(void)
{
    for (int kind = 0; kind < 2; kind++) { /* given as a shape, as curvatures */
        sb_vec3 nodes[16], straight[16], lost[16];
        sb_real curvature[32];
        ndl_rod_def def = ndl_default_rod_def();
        ndl_rod *rod;
        double worst = 0;
        for (int i = 0; i < 16; i++) {
            double s = i < 8 ? 0 : 0.01 * (i - 8), r = 0.08;
            nodes[i] = sb_v3(REAL(i < 8 ? 0.01 * (i - 8) : r * sin(s / r)), REAL(r * (1 - cos(s / r))), REAL(0.02 * s));
            curvature[2 * i] = REAL(i < 8 ? 0 : 12.5);
            curvature[2 * i + 1] = REAL(i < 8 ? 0 : 3);
        }
        straight_nodes(straight, 16, 0.15, sb_v3(1, 0, 0));
        def.nodes = kind ? straight : nodes;
        def.node_count = 16;
        def.rest = kind ? NDL_REST_CURVATURE : NDL_REST_SHAPE;
        def.rest_curvature = curvature;
        def.director = sb_v3(0, 1, 0);
        def.damping_bending = REAL(2e-3);
        rod = make_rod(&def);
        if (kind == 0) {
            for (int i = 0; i < 16; i++)
                lost[i] = sb_v3(nodes[0].x + REAL(0.01) * REAL(i), REAL(i > 1 ? 0.001 * (i - 1) : 0),
                                REAL(i > 1 ? -0.002 * (i - 1) : 0));
            CHECK_OK(ndl_rod_set_positions(rod, lost, NULL));
            CHECK(elastic(rod) > 1e-3);
        }
        for (int s = 0; s < 1500; s++)
            CHECK_OK(ndl_rod_step(rod, REAL(2e-3), NULL));
        for (int i = 0; i < 16 && kind == 0; i++)
            worst = fmax(worst, norm(sb_v3_sub(ndl_rod_positions(rod)[i], nodes[i])));
        CHECK_NEAR(worst, 0, 1e-8);
        CHECK_NEAR(elastic(rod), 0, 1e-10);
        for (int i = 2; i < 15; i++) {
            sb_real found[2];
            ndl_rod_curvature(rod, i, found);
            if (kind) {
                CHECK_NEAR((double)found[0], (double)curvature[2 * i], 0.01 * 12.5);
                CHECK_NEAR((double)found[1], (double)curvature[2 * i + 1], 0.01 * 12.5);
            }
        }
        ndl_rod_destroy(rod);
    }
}

/* ---- supports ---- */

/* What holds a step's or a solve's supports balances the loads and the rate of momentum. */
static void test_reactions(void)
{
    sb_vec3 nodes[13], force, torque;
    ndl_rod_def def = ndl_default_rod_def();
    ndl_rod *rod;
    double weight = 0, lever = 0;
    straight_nodes(nodes, 13, 0.24, sb_v3(1, 0, 0));
    def.nodes = nodes;
    def.node_count = 13;
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    rod = make_rod(&def);
    for (int i = 0; i < 13; i++)
        weight += 9.81 * (double)ndl_rod_mass(rod, i);
    CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
    for (int i = 0; i < 13; i++)
        lever += 9.81 * (double)ndl_rod_mass(rod, i) * (double)ndl_rod_positions(rod)[i].x;
    ndl_rod_base_wrench(rod, &force, &torque);
    CHECK_NEAR((double)force.z / weight, 1, scene_tolerance(1e-7, 100));
    CHECK_NEAR((double)torque.y / -lever, 1, scene_tolerance(1e-6, 100));
    for (int s = 0; s < 20; s++) /* nothing moves once the load is taken */
        CHECK_OK(ndl_rod_step(rod, REAL(0.01), NULL));
    CHECK_NEAR((double)ndl_rod_reactions(rod)[0].z + (double)ndl_rod_reactions(rod)[1].z, weight,
               scene_tolerance(1e-5, 1e3) * weight);
    for (int i = 2; i < 13; i++)
        CHECK_NEAR(norm(ndl_rod_reactions(rod)[i]), 0, 0);
    CHECK_OK(ndl_rod_release(rod, 0));
    CHECK_OK(ndl_rod_release(rod, 1));
    CHECK_OK(ndl_rod_set_velocities(rod, nodes));
    CHECK_OK(ndl_rod_step(rod, REAL(1e-4), NULL));
    for (int i = 0; i < 13; i++)
        CHECK_NEAR(norm(ndl_rod_reactions(rod)[i]), 0, 0);
    ndl_rod_destroy(rod);
}

/* A sleeve that moves, tilts and turns takes the base with it, and the whole needle in the end. */
static void test_sleeve(void)
{
    ndl_rod *rod = cantilever(10, 0.2, sb_v3(1, 0, 0), 1), *at_once = cantilever(10, 0.2, sb_v3(1, 0, 0), 1);
    ndl_frame frame;
    sb_vec3 tip, t, d, velocity = sb_v3(REAL(0.2), 0, 0), spin = sb_v3(0, 0, 1);
    for (int s = 1; s <= 100; s++) {
        double a = 0.01 * s, c = 0.02 * s;
        t = sb_v3(REAL(cos(a)), REAL(sin(a)), 0);
        d = sb_v3(REAL(-sin(a) * cos(c)), REAL(cos(a) * cos(c)), REAL(sin(c)));
        CHECK_OK(ndl_rod_hold_base(rod, sb_v3(REAL(0.002 * s), 0, 0), t, d, &velocity, &spin));
        CHECK_OK(ndl_rod_step(rod, REAL(0.01), NULL));
        frame = ndl_rod_frame(rod, 0);
        CHECK_NEAR(norm(sb_v3_sub(frame.t, t)), 0, scene_tolerance(1e-12, 10));
        CHECK_NEAR(norm(sb_v3_sub(frame.m1, d)), 0, scene_tolerance(1e-12, 10));
        CHECK_NEAR(norm(sb_v3_sub(ndl_rod_positions(rod)[0], sb_v3(REAL(0.002 * s), 0, 0))), 0, 0);
    }
    CHECK_NEAR(norm(sb_v3_sub(ndl_rod_velocities(rod)[0], velocity)), 0, 0);
    CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
    ndl_rod_tip(rod, &tip, &frame);
    CHECK_NEAR(norm(sb_v3_sub(tip, sb_v3_madd(sb_v3(REAL(0.2), 0, 0), REAL(0.22), t))), 0, scene_tolerance(1e-9, 10));
    CHECK_NEAR(norm(sb_v3_sub(frame.m1, d)), 0, scene_tolerance(1e-8, 10));
    CHECK_OK(
        ndl_rod_hold_base(at_once, sb_v3(REAL(0.2), 0, 0), t, d, NULL, NULL)); /* a static solve goes there in pieces */
    CHECK_OK(ndl_rod_solve_static(at_once, NULL, NULL));
    ndl_rod_tip(at_once, &tip, &frame);
    CHECK_NEAR(norm(sb_v3_sub(tip, ndl_rod_positions(rod)[11])), 0, scene_tolerance(1e-9, 10));
    CHECK_NEAR(norm(sb_v3_sub(frame.m1, d)), 0, scene_tolerance(1e-8, 10));
    ndl_rod_destroy(rod);
    ndl_rod_destroy(at_once);
}

/* ---- scale ---- */

/* The same needle a thousand times smaller or larger, with loads to match: the same shape. */
static void test_scales(void)
{
    double first[3] = {0, 0, 0};
    for (int k = 0; k < 3; k++) {
        double scale = k == 0 ? 1 : k == 1 ? 1e-3 : 1e3;
        ndl_rod *rod = cantilever(15, 0.2 * scale, sb_v3(1, 1, 0), scale);
        double ei = stylet_bending() * pow(scale, 4), moved;
        ndl_rod_info info;
        CHECK_OK(ndl_rod_set_force(rod, 16, sb_v3(0, 0, REAL(2 * ei / (0.04 * scale * scale)))));
        CHECK_OK(ndl_rod_solve_static(rod, NULL, &info));
        moved = (double)ndl_rod_positions(rod)[16].z / scale;
        CHECK_OK(ndl_rod_set_damping(rod, REAL(1e-4 * scale), REAL(1e-4 * scale)));
        CHECK_OK(ndl_rod_set_force(rod, 16, sb_v3(0, 0, 0)));
        for (int s = 0; s < 20; s++) /* the speed of sound stays: times go with lengths */
            CHECK_OK(ndl_rod_step(rod, REAL(0.002 * scale), NULL));
        if (k == 0) {
            first[0] = moved;
            first[1] = (double)ndl_rod_positions(rod)[16].z;
            first[2] = info.newton_iterations;
        }
        CHECK_NEAR(moved / first[0], 1, scene_tolerance(1e-8, 1e2));
        CHECK_NEAR((double)ndl_rod_positions(rod)[16].z / scale, first[1], scene_tolerance(1e-5, 1e3) * 0.1);
        CHECK_NEAR(info.newton_iterations, first[2], 2);
        ndl_rod_destroy(rod);
    }
}

/* ---- changing the number of nodes ---- */

/* A pre-bent, bent, moving needle: splitting and merging keep tip, mass, momentum, rest length, and (nearly) the
 * shape. */
static void test_split_and_merge(void)
{
    sb_vec3 nodes[12], tip, velocities[12];
    ndl_rod_def def = ndl_default_rod_def();
    ndl_rod *rod;
    double before[3], after[3], turn[3], scale, mass = 0, length = 0, energy, again;
    for (int i = 0; i < 12; i++) {
        double s = 0.015 * i / 0.1;
        nodes[i] = sb_v3(REAL(0.1 * sin(s)), REAL(0.1 * (1 - cos(s))), 0);
        velocities[i] = sb_v3(REAL(0.1), REAL(0.3 * s * s), REAL(-0.2 * s));
    }
    def.nodes = nodes;
    def.node_count = 12;
    def.capacity = 14;
    def.rest = NDL_REST_SHAPE;
    rod = make_rod(&def);
    CHECK_OK(ndl_rod_set_force(rod, 11, sb_v3(0, 0, REAL(0.4))));
    CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
    CHECK_OK(ndl_rod_set_velocities(rod, velocities));
    ndl_rod_tip(rod, &tip, NULL);
    energy = (double)ndl_rod_energies(rod).bend + (double)ndl_rod_energies(rod).twist;
    sums(rod, before, turn, &scale);
    for (int i = 0; i < 12; i++) {
        mass += (double)ndl_rod_mass(rod, i);
        length += i < 11 ? (double)ndl_rod_rest_length(rod, i) : 0;
    }
    for (int round = 0; round < 3; round++) {
        if (round < 2)
            CHECK_OK(ndl_rod_split_edge(rod, round ? 10 : 5));
        else
            CHECK_OK(ndl_rod_merge_node(rod, 6));
        CHECK_INT(ndl_rod_node_count(rod), round == 1 ? 14 : 13);
        if (round == 1)
            CHECK_RESULT(ndl_rod_split_edge(rod, 3), SB_ERROR_UNSUPPORTED);
        sums(rod, after, turn, &scale);
        for (int k = 0; k < 3; k++)
            CHECK_NEAR((after[k] - before[k]) / scale, 0, scene_tolerance(1e-13, 10));
        CHECK_NEAR(norm(sb_v3_sub(ndl_rod_positions(rod)[ndl_rod_node_count(rod) - 1], tip)), 0, 0);
        for (int i = 0; i < ndl_rod_node_count(rod); i++) {
            mass -= (double)ndl_rod_mass(rod, i);
            length -= i < ndl_rod_node_count(rod) - 1 ? (double)ndl_rod_rest_length(rod, i) : 0;
        }
        CHECK_NEAR(mass, 0, scene_tolerance(1e-15, 1) * 10);
        CHECK_NEAR(length, 0, scene_tolerance(1e-15, 1) * 10);
        again = (double)ndl_rod_energies(rod).bend + (double)ndl_rod_energies(rod).twist;
        CHECK_NEAR(again / energy, 1, 0.1);
        for (int i = 0; i < ndl_rod_node_count(rod); i++) {
            mass += (double)ndl_rod_mass(rod, i);
            length += i < ndl_rod_node_count(rod) - 1 ? (double)ndl_rod_rest_length(rod, i) : 0;
        }
    }
    CHECK_RESULT(ndl_rod_merge_node(rod, 1), SB_ERROR_UNSUPPORTED); /* held */
    CHECK_RESULT(ndl_rod_merge_node(rod, 0), SB_ERROR_UNSUPPORTED);
    CHECK_RESULT(ndl_rod_merge_node(rod, 13), SB_ERROR_INDEX);
    CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
    CHECK_NEAR(norm(sb_v3_sub(ndl_rod_positions(rod)[12], tip)), 0, 5e-4);
    ndl_rod_destroy(rod);
}

/* Insertion through a sleeve, splitting and merging behind it, moves the tip of a free needle straight ahead; a tip
 * held against turning keeps its frame. */
static void test_feed(void)
{
    sb_vec3 nodes[8], tip;
    ndl_rod_def def = ndl_default_rod_def();
    ndl_rod *rod;
    straight_nodes(nodes, 8, 0.07, sb_v3(0, 0, 1));
    def.nodes = nodes;
    def.node_count = 8;
    def.capacity = 20;
    rod = make_rod(&def);
    for (int way = 1; way >= -1; way -= 2) {
        for (int s = 0; s < 500; s++) {
            CHECK_OK(ndl_rod_feed(rod, REAL(way * 1e-4)));
            if ((double)ndl_rod_rest_length(rod, 1) > 0.0102)
                CHECK_OK(ndl_rod_split_edge(rod, 1));
            if ((double)ndl_rod_rest_length(rod, 1) < 0.003 && ndl_rod_node_count(rod) > 5)
                CHECK_OK(ndl_rod_merge_node(rod, 2));
            CHECK_OK(ndl_rod_turn(rod, 0, REAL(0.01)));
            if (!CHECK_OK(ndl_rod_step(rod, REAL(0.01), NULL)))
                return;
        }
        ndl_rod_tip(rod, &tip, NULL);
        CHECK_NEAR((double)tip.z, way > 0 ? 0.12 : 0.07, 1e-5);
        CHECK_NEAR(fabs((double)tip.x) + fabs((double)tip.y), 0, 1e-9);
    }
    CHECK_RESULT(ndl_rod_feed(rod, REAL(-0.1)), SB_ERROR_ARGUMENT);
    ndl_rod_destroy(rod);
}

/* ---- failures ---- */

static unsigned long long state_hash(const ndl_rod *rod)
{
    size_t n = (size_t)ndl_rod_node_count(rod);
    unsigned long long hash = scene_hash(ndl_rod_positions(rod), n * sizeof(sb_vec3)) ^
                              3 * scene_hash(ndl_rod_velocities(rod), n * sizeof(sb_vec3)) ^
                              5 * scene_hash(ndl_rod_reactions(rod), n * sizeof(sb_vec3));
    for (size_t j = 0; j + 1 < n; j++) {
        ndl_frame frame = ndl_rod_frame(rod, (int)j);
        hash = 7 * hash ^ scene_hash(&frame, sizeof frame);
    }
    return hash;
}

/* Steps and solves that cannot be leave no trace: what comes after is as if they had not been. */
static void test_undo(void)
{
    ndl_rod *rods[2];
    ndl_rod_info info;
    check_bad_numbers();
    for (int b = 0; b < 2; b++) {
        rods[b] = cantilever(10, 0.2, sb_v3(1, 0, 0), 1);
        CHECK_OK(ndl_rod_set_force(rods[b], 11, sb_v3(0, REAL(0.5), 0)));
        for (int s = 0; s < 5; s++)
            CHECK_OK(ndl_rod_step(rods[b], REAL(0.01), NULL));
        CHECK_OK(ndl_rod_turn(rods[b], 0, REAL(0.3))); /* still due after a failure */
    }
    for (int kind = 0; kind < (SB_REAL_IS_FLOAT ? 2 : 3); kind++) { /* double holds what float's largest force does */
        unsigned long long hash = state_hash(rods[0]);
        if (kind < 2) /* an edge without length: no energy there */
            CHECK_OK(ndl_rod_hold(rods[0], 5, ndl_rod_positions(rods[0])[1], NULL));
        if (kind < 2)
            CHECK_OK(ndl_rod_hold(rods[0], 6, ndl_rod_positions(rods[0])[1], NULL));
        else
            CHECK_OK(ndl_rod_set_force(rods[0], 4, sb_v3(SB_REAL_MAX, 0, 0)));
        if (kind == 1) {
            CHECK(ndl_rod_solve_static(rods[0], NULL, &info) != SB_OK);
        } else {
            CHECK(ndl_rod_step(rods[0], REAL(0.01), &info) != SB_OK);
        }
        CHECK(info.error.result == SB_ERROR_DIVERGED || info.error.result == SB_ERROR_NOT_CONVERGED);
        CHECK(state_hash(rods[0]) == hash);
        CHECK_OK(ndl_rod_release(rods[0], 5));
        CHECK_OK(ndl_rod_release(rods[0], 6));
        CHECK_OK(ndl_rod_set_force(rods[0], 4, sb_v3(0, 0, 0)));
    }
    for (int s = 0; s < 5; s++)
        for (int b = 0; b < 2; b++)
            CHECK_OK(ndl_rod_step(rods[b], REAL(0.01), NULL));
    CHECK(state_hash(rods[0]) == state_hash(rods[1]));
    for (int b = 0; b < 2; b++) {
        ndl_rod_static_options options = ndl_default_rod_static_options();
        options.max_newton = 1;
        CHECK_OK(ndl_rod_set_force(rods[b], 11, sb_v3(0, 0, 3)));
        if (b == 0)
            CHECK_RESULT(ndl_rod_solve_static(rods[b], &options, NULL), SB_ERROR_NOT_CONVERGED);
        CHECK_OK(ndl_rod_solve_static(rods[b], NULL, NULL));
    }
    CHECK(state_hash(rods[0]) == state_hash(rods[1]));
    ndl_rod_destroy(rods[0]);
    ndl_rod_destroy(rods[1]);
}

/* Each allocation fails in turn; steps, solves and changes of nodes allocate nothing. */
static void test_memory(void)
{
    sb_vec3 nodes[8];
    ndl_rod_def def = ndl_default_rod_def();
    scene_memory memory = {0, 0, 0, 0};
    ndl_rod *rod = NULL;
    sb_error error;
    int failures = 0;
    straight_nodes(nodes, 8, 0.1, sb_v3(1, 0, 0));
    def.nodes = nodes;
    def.node_count = 8;
    def.capacity = 10;
    def.allocator = scene_allocator(&memory);
    for (memory.fail_at = 1; ndl_rod_create(&def, &rod, &error) != SB_OK && failures < 10; memory.fail_at++) {
        CHECK_INT(error.result, SB_ERROR_MEMORY);
        CHECK(rod == NULL);
        CHECK_INT(memory.live, 0);
        memory.calls = 0;
        failures++;
    }
    CHECK_INT(failures, 2);
    memory.calls = 0;
    CHECK_OK(ndl_rod_set_force(rod, 7, sb_v3(0, 1, 0)));
    CHECK_OK(ndl_rod_step(rod, REAL(0.01), NULL));
    CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
    CHECK_OK(ndl_rod_split_edge(rod, 3));
    CHECK_OK(ndl_rod_merge_node(rod, 4));
    CHECK_INT(memory.calls, 0);
    ndl_rod_destroy(rod);
    CHECK_INT(memory.live, 0);
    ndl_rod_destroy(NULL);
    def.allocator.alloc = NULL;
    def.allocator.release = NULL;
    def.capacity = 2147483647;
    def.node_count = 8;
    rod = NULL;
    if (sizeof(size_t) == 4) { /* elsewhere such a rod may be had */
        CHECK_RESULT(ndl_rod_create(&def, &rod, NULL), SB_ERROR_MEMORY);
        CHECK(rod == NULL);
    }
}

static void test_bad_defs(void)
{
    sb_real nan = REAL(NAN), curvature[10] = {0, 0, 0, 0, 1000, 0, 0, 0, 0, 0};
    check_bad_numbers();
    for (int kind = 0; kind < 22; kind++) {
        sb_vec3 nodes[5];
        ndl_rod_def def = ndl_default_rod_def();
        ndl_rod_stiffness stiffness = ndl_rod_stiffness_of(&def.section);
        ndl_rod *rod = NULL;
        sb_error error;
        sb_result expected = SB_ERROR_ARGUMENT;
        int node = -1;
        straight_nodes(nodes, 5, 0.1, sb_v3(1, 0, 0));
        def.nodes = nodes;
        def.node_count = 5;
        switch (kind) {
        case 0: def.cookie = 0; break;
        case 1: def.nodes = NULL; break;
        case 2: def.node_count = 1; break;
        case 3: def.capacity = 4; break;
        case 4: def.rest = (ndl_rod_rest)0; break;
        case 5: def.rest = NDL_REST_CURVATURE; break;
        case 6: def.director.y = nan, expected = SB_ERROR_NOT_FINITE; break;
        case 7: def.gravity.y = nan, expected = SB_ERROR_NOT_FINITE; break;
        case 8: def.damping_bending = -1; break;
        case 9: def.damping_stretch = nan; break;
        case 10: def.max_newton = 0; break;
        case 11: def.tolerance = 1; break;
        case 12: def.clamped = 7; break;
        case 13: nodes[3].z = nan, expected = SB_ERROR_NOT_FINITE, node = 3; break;
        case 14: nodes[3] = nodes[2], expected = SB_ERROR_MESH, node = 3; break;
        case 15: nodes[3] = nodes[1], expected = SB_ERROR_MESH, node = 2; break;
        case 16: def.section.inner_radius = def.section.radius; break;
        case 17: def.section.poisson = REAL(0.6); break;
        case 18: def.section.young = nan; break;
        case 19: stiffness.twist = 0, def.stiffness = &stiffness; break;
        case 20: def.rest = NDL_REST_CURVATURE, def.rest_curvature = curvature, node = 2; break;
        default:
            def.rest = NDL_REST_CURVATURE, def.rest_curvature = curvature, curvature[4] = nan;
            expected = SB_ERROR_NOT_FINITE, node = 2;
            break;
        }
        if (!CHECK_RESULT(ndl_rod_create(&def, &rod, &error), expected))
            printf("kind %d\n", kind);
        CHECK_INT(error.node, node);
        CHECK(error.message[0] != 0);
        CHECK(rod == NULL);
        ndl_rod_destroy(rod);
    }
    CHECK_RESULT(ndl_rod_create(NULL, NULL, NULL), SB_ERROR_ARGUMENT);
}

static void test_bad_calls(void)
{
    ndl_rod *rod = cantilever(5, 0.1, sb_v3(1, 0, 0), 1);
    ndl_rod_section section;
    ndl_rod_static_options options = ndl_default_rod_static_options();
    sb_vec3 bad = sb_v3(0, REAL(NAN), 0), good = sb_v3(0, 0, 1), folded[7];
    unsigned long long hash = state_hash(rod);
    ndl_rod_info info;
    sb_error error;
    CHECK_RESULT(ndl_rod_section_preset((ndl_rod_preset)0, &section), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_section_preset(NDL_STYLET_18G, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_hold(rod, 7, good, NULL), SB_ERROR_INDEX);
    CHECK_RESULT(ndl_rod_hold(rod, 6, bad, NULL), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(ndl_rod_hold(rod, 6, good, &bad), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(ndl_rod_hold(NULL, 6, good, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_release(rod, -1), SB_ERROR_INDEX);
    CHECK_RESULT(ndl_rod_turn(rod, 6, 1), SB_ERROR_INDEX);
    CHECK_RESULT(ndl_rod_turn(rod, 5, bad.y), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(ndl_rod_release_turn(rod, 6), SB_ERROR_INDEX);
    CHECK_RESULT(ndl_rod_hold_base(rod, good, sb_v3(0, 0, 0), good, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_hold_base(rod, good, good, good, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_hold_base(rod, good, good, sb_v3(1, 0, 0), &good, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_hold_base(rod, bad, good, sb_v3(1, 0, 0), NULL, NULL), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(ndl_rod_hold_base(NULL, good, good, sb_v3(1, 0, 0), NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_set_force(rod, 0, bad), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(ndl_rod_set_force(rod, 7, good), SB_ERROR_INDEX);
    CHECK_RESULT(ndl_rod_set_torque(rod, 6, 1), SB_ERROR_INDEX);
    CHECK_RESULT(ndl_rod_set_torque(rod, 0, bad.y), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(ndl_rod_set_gravity(rod, bad), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(ndl_rod_set_damping(rod, -1, 0), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_set_velocities(rod, NULL), SB_ERROR_ARGUMENT);
    for (int i = 0; i < 7; i++)
        folded[i] = sb_v3(REAL(i == 4 ? 0.02 : 0.02 * i), 0, 0);
    CHECK_RESULT(ndl_rod_set_positions(rod, folded, &error), SB_ERROR_MESH);
    folded[2] = bad;
    CHECK_RESULT(ndl_rod_set_positions(rod, folded, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.node, 2);
    CHECK_RESULT(ndl_rod_set_velocities(rod, folded), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(ndl_rod_split_edge(rod, 6), SB_ERROR_INDEX);
    CHECK_RESULT(ndl_rod_split_edge(rod, 0), SB_ERROR_UNSUPPORTED);
    CHECK_RESULT(ndl_rod_feed(rod, bad.y), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(ndl_rod_step(rod, 0, &info), SB_ERROR_ARGUMENT);
    check_bad_numbers();
    CHECK_RESULT(ndl_rod_step(rod, bad.y, &info), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_step(NULL, 1, NULL), SB_ERROR_ARGUMENT);
    options.cookie = 0;
    CHECK_RESULT(ndl_rod_solve_static(rod, &options, &info), SB_ERROR_ARGUMENT);
    CHECK(state_hash(rod) == hash);
    for (int i = 0; i < 2; i++)
        CHECK_OK(ndl_rod_release(rod, i));
    CHECK_OK(ndl_rod_release_turn(rod, 0));
    CHECK_RESULT(ndl_rod_solve_static(rod, NULL, &info), SB_ERROR_UNCONSTRAINED);
    CHECK_OK(ndl_rod_set_torque(rod, 3, 1));
    CHECK_RESULT(ndl_rod_step(rod, 1, &info), SB_ERROR_UNCONSTRAINED);
    ndl_rod_destroy(rod);
}

/* The same bits from every compiler and optimisation, in double: bending, twist, damping, a sleeve, a static solve. */
static void test_golden(void)
{
    sb_vec3 nodes[12];
    sb_real curvature[24];
    ndl_rod_def def = ndl_default_rod_def();
    ndl_rod *rod;
    unsigned long long hash = 0;
    for (int i = 0; i < 12; i++) {
        nodes[i] = sb_v3(REAL(0.015625 * i), 0, 0);
        curvature[2 * i] = REAL(0.5 * i);
        curvature[2 * i + 1] = REAL(i > 6 ? 2 : 0);
    }
    def.nodes = nodes;
    def.node_count = 12;
    def.rest = NDL_REST_CURVATURE;
    def.rest_curvature = curvature;
    def.gravity = sb_v3(0, 0, REAL(-9.75));
    rod = make_rod(&def);
    for (int s = 1; s <= 40; s++) {
        CHECK_OK(ndl_rod_hold_base(rod, sb_v3(0, 0, REAL(0.0009765625 * s)), sb_v3(64, 1, 0),
                                   sb_v3(0, REAL(64 - s), REAL(s)), NULL, NULL));
        CHECK_OK(ndl_rod_step(rod, REAL(0.0078125), NULL));
        hash = 31 * hash + state_hash(rod);
    }
    CHECK_OK(ndl_rod_turn(rod, 10, REAL(0.5)));
    CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
    hash = 31 * hash + state_hash(rod);
    if (!SB_REAL_IS_FLOAT && !CHECK(hash == 0x8d4ce0ef037b1643ULL))
        printf("hash 0x%llxULL\n", hash);
    ndl_rod_destroy(rod);
}

/* Base and tip dragged and turned at random, with forces, in large steps; then let go and at rest again. */
static void test_violence(void)
{
    unsigned long long seed = 11;
    ndl_rod *rod = cantilever(14, 0.2, sb_v3(1, 0, 0), 1);
    int failed = 0;
    for (int s = 0; s < (check_quick() ? 200 : 1500); s++) {
        ndl_rod_info info;
        sb_vec3 force;
        force.x = REAL(check_random_in(&seed, -20, 20));
        force.y = REAL(check_random_in(&seed, -20, 20));
        force.z = REAL(check_random_in(&seed, -20, 20));
        CHECK_OK(ndl_rod_set_force(rod, 1 + (int)(14 * check_random(&seed)), force));
        if (s % 5 == 0)
            CHECK_OK(ndl_rod_turn(rod, s % 2 ? 0 : 14, REAL(check_random_in(&seed, -1, 1))));
        if (s % 7 == 0)
            CHECK_OK(ndl_rod_release_turn(rod, 14));
        failed += ndl_rod_step(rod, REAL(check_random_in(&seed, 1e-4, 2e-2)), &info) != SB_OK;
        if (!CHECK(scene_all_finite(ndl_rod_positions(rod), 16)) || !CHECK(norm(ndl_rod_positions(rod)[15]) < 1))
            break;
    }
    CHECK_INT(failed, 0);
    CHECK_OK(ndl_rod_release_turn(rod, 14));
    CHECK_OK(ndl_rod_set_damping(rod, REAL(1e-3), REAL(1e-2)));
    for (int i = 0; i < 16; i++)
        CHECK_OK(ndl_rod_set_force(rod, i, sb_v3(0, 0, 0)));
    for (int s = 0; s < 400; s++)
        CHECK_OK(ndl_rod_step(rod, REAL(0.01), NULL));
    CHECK_NEAR(norm(sb_v3_sub(ndl_rod_positions(rod)[15], sb_v3(REAL(0.2 * 15 / 14), 0, 0))), 0, 1e-6);
    ndl_rod_destroy(rod);
}

CHECK_SUITE(rod, {"forces are the energy's gradient", test_gradients},
            {"small deflection (Euler-Bernoulli)", test_small_deflection},
            {"large deflection (elastica)", test_elastica}, {"a twisted rod buckles (Greenhill)", test_greenhill},
            {"beyond buckling", test_post_buckling}, {"at Euler's load", test_buckling_load},
            {"a free tip turns with the base", test_free_tip_turns}, {"torsion; a quarter circle", test_torsion},
            {"first frequency of a cantilever", test_frequency}, {"momentum of a free rod", test_momentum},
            {"no step gains energy", test_energy}, {"one linear system a step", test_linearised},
            {"a pre-bent rod comes to rest", test_prebent_rests}, {"reactions", test_reactions},
            {"a sleeve moves the base", test_sleeve}, {"the same at every scale", test_scales},
            {"split and merge", test_split_and_merge}, {"feed through a sleeve", test_feed},
            {"failures are undone", test_undo}, {"every allocation fails", test_memory}, {"bad defs", test_bad_defs},
            {"bad calls", test_bad_calls}, {"golden", test_golden}, {"violence", test_violence});
