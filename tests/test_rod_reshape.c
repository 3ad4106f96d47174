/* Reparameterisation of rods: what stays, what follows by arc distance, how fast errors fall, failures. */
#include "check.h"
#include "needle.h"
#include "scene.h"

enum { MOST = 96 };

static ndl_rod *make_rod(const ndl_rod_def *def)
{
    ndl_rod *rod = NULL;
    CHECK_OK(ndl_rod_create(def, &rod, NULL));
    return rod;
}

/* The point at the arc distance s of a circle of this radius that leaves the origin along x, towards y. */
static sb_vec3 on_circle(double radius, double s)
{
    return sb_v3(REAL(radius * sin(s / radius)), REAL(radius * (1 - cos(s / radius))), 0);
}

static int compare(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* n stations over [0, length] whose neighbours are not too near; 0 and 1 as given. */
static void random_stations(double *s, int n, double first, double length, unsigned long long *seed)
{
    s[0] = 0;
    s[1] = first;
    for (int i = 2; i < n; i++)
        s[i] = first + (length - first) * (i - 1 + check_random_in(seed, -0.3, 0.3)) / (n - 2);
    s[n - 1] = length;
    qsort(s, (size_t)n, sizeof *s, compare);
}

static double total_length(const ndl_rod *rod)
{
    double sum = 0;
    for (int j = 0; j < ndl_rod_node_count(rod) - 1; j++)
        sum += (double)ndl_rod_rest_length(rod, j);
    return sum;
}

static double total_mass(const ndl_rod *rod)
{
    double sum = 0;
    for (int i = 0; i < ndl_rod_node_count(rod); i++)
        sum += (double)ndl_rod_mass(rod, i);
    return sum;
}

static void momentum(const ndl_rod *rod, double p[3])
{
    p[0] = p[1] = p[2] = 0;
    for (int i = 0; i < ndl_rod_node_count(rod); i++) {
        sb_vec3 v = ndl_rod_velocities(rod)[i];
        double m = (double)ndl_rod_mass(rod, i);
        p[0] += m * (double)v.x;
        p[1] += m * (double)v.y;
        p[2] += m * (double)v.z;
    }
}

/* A wire of n nodes, curved and bent out of its plane; kind 1: that is its rest, 2: it is stiffer one way, too. */
static ndl_rod *wire(int n, int capacity, int kind, int clamped)
{
    static sb_vec3 nodes[MOST];
    ndl_rod_def def = ndl_default_rod_def();
    ndl_rod_stiffness stiffness = ndl_rod_stiffness_of(&def.section);
    stiffness.bending[1] *= kind == 2 ? 2 : 1;
    for (int i = 0; i < n; i++) {
        double s = 0.2 * i / (n - 1);
        nodes[i] = sb_v3(REAL(s), REAL(2 * s * s), REAL(8 * s * s * s));
    }
    def.nodes = nodes;
    def.node_count = n;
    def.capacity = capacity;
    def.stiffness = &stiffness;
    def.rest = kind ? NDL_REST_SHAPE : NDL_REST_STRAIGHT;
    def.clamped = clamped;
    return make_rod(&def);
}

static void test_identity(void)
{
    for (int kind = 0; kind < 3; kind++) {
        ndl_rod *rod = wire(17, 17, kind, 1);
        sb_vec3 before[17], velocities[17], again[17];
        ndl_frame tip, base, now;
        ndl_rod_energy was, is;
        double lengths[16], scale;
        CHECK_OK(ndl_rod_set_damping(rod, 0, 0)); /* viscous moments, too, turn frames at the end of a step */
        for (int s = 0; s < 5; s++) {
            CHECK_OK(ndl_rod_turn(rod, 0, REAL(0.1)));
            CHECK_OK(ndl_rod_step(rod, REAL(0.001), NULL));
        }
        was = ndl_rod_energies(rod);
        base = ndl_rod_frame(rod, 0);
        ndl_rod_tip(rod, NULL, &tip);
        for (int i = 0; i < 17; i++) {
            before[i] = ndl_rod_positions(rod)[i];
            velocities[i] = ndl_rod_velocities(rod)[i];
            if (i < 16)
                lengths[i] = (double)ndl_rod_rest_length(rod, i);
        }
        CHECK_OK(ndl_rod_reparameterise(rod, before, 17, NULL));
        is = ndl_rod_energies(rod);
        scale = (double)was.bend + (double)was.kinetic + (double)was.stretch;
        CHECK_NEAR((double)(is.bend - was.bend) / scale, 0, scene_tolerance(1e-9, 1e4));
        CHECK_NEAR((double)(is.kinetic - was.kinetic) / scale, 0, scene_tolerance(1e-9, 1e4));
        memcpy(again, ndl_rod_positions(rod), sizeof again);
        CHECK(memcmp(again, before, sizeof again) == 0);
        for (int i = 0; i < 17; i++)
            CHECK_NEAR((double)sb_v3_norm(sb_v3_sub(ndl_rod_velocities(rod)[i], velocities[i])), 0,
                       scene_tolerance(1e-11, 1e4));
        for (int j = 0; j < 16; j++)
            CHECK_NEAR((double)ndl_rod_rest_length(rod, j) / lengths[j], 1, scene_tolerance(1e-13, 100));
        now = ndl_rod_frame(rod, 0);
        CHECK_NEAR((double)sb_v3_norm(sb_v3_sub(now.m1, base.m1)), 0, scene_tolerance(1e-14, 10));
        ndl_rod_tip(rod, NULL, &now);
        CHECK_NEAR((double)sb_v3_norm(sb_v3_sub(now.m1, tip.m1)), 0, scene_tolerance(1e-11, 10));
        CHECK_OK(ndl_rod_step(rod, REAL(0.001), NULL));
        ndl_rod_destroy(rod);
    }
}

/* A wire bent to a circle at rest, told anew 200 times with other nodes: radius, rest shape, length and mass stay. */
static void test_arcs(void)
{
    unsigned long long seed = 3;
    double radius = 0.1, length = 0.15, s[MOST], whole, mass;
    sb_vec3 nodes[MOST];
    ndl_rod_def def = ndl_default_rod_def();
    ndl_rod *rod;
    def.nodes = nodes;
    def.node_count = 40;
    def.capacity = 60;
    def.rest = NDL_REST_SHAPE;
    for (int i = 0; i < 40; i++)
        nodes[i] = on_circle(radius, length * i / 39);
    rod = make_rod(&def);
    whole = total_length(rod);
    mass = total_mass(rod);
    for (int round = 0; round < 200; round++) {
        int n = 25 + (int)(36 * check_random(&seed));
        double worst = 0;
        random_stations(s, n, length / 39, length, &seed);
        for (int i = 0; i < n; i++)
            nodes[i] = on_circle(radius, s[i]);
        CHECK_OK(ndl_rod_reparameterise(rod, nodes, n, NULL));
        CHECK_INT(ndl_rod_node_count(rod), n);
        CHECK(memcmp(ndl_rod_positions(rod), nodes, (size_t)n * sizeof *nodes) == 0);
        CHECK_NEAR(total_length(rod) / whole, 1, scene_tolerance(1e-13, 100));
        CHECK_NEAR(total_mass(rod) / mass, 1, scene_tolerance(1e-13, 100));
        for (int i = 2; i < n - 1; i++) {
            sb_real curvature[2];
            ndl_rod_curvature(rod, i, curvature);
            worst = fmax(worst, fabs(hypot((double)curvature[0], (double)curvature[1]) * radius - 1));
        }
        CHECK(worst < 5e-3);
    }
    CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL)); /* what it now takes for its rest is still that circle */
    for (int i = 0; i < ndl_rod_node_count(rod); i++)
        CHECK_NEAR((double)sb_v3_norm(sb_v3_sub(ndl_rod_positions(rod)[i], sb_v3(0, REAL(radius), 0))) / radius, 1,
                   2e-3);
    ndl_rod_destroy(rod);
}

/* The same for a wire that comes out of its clamp straight and is then bent by its rest curvature alone. */
static void test_curvature(void)
{
    unsigned long long seed = 6;
    enum { COUNT = 31 };
    double radius = 0.12, h = 0.15 / (COUNT - 1), s[COUNT];
    sb_vec3 nodes[COUNT];
    sb_real bends[2 * COUNT], curvature[2];
    ndl_rod_def def = ndl_default_rod_def();
    ndl_rod *rod;
    for (int i = 0; i < COUNT; i++) {
        nodes[i] = sb_v3(REAL(h * i), 0, 0);
        bends[2 * i] = REAL(1 / radius);
        bends[2 * i + 1] = REAL(-0.5 / radius);
    }
    def.nodes = nodes;
    def.node_count = COUNT;
    def.director = sb_v3(0, 1, 0);
    def.rest = NDL_REST_CURVATURE;
    def.rest_curvature = bends;
    rod = make_rod(&def);
    CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
    for (int round = 0; round < 50; round++) {
        int n = ndl_rod_node_count(rod), cells = n - 2;
        random_stations(s, COUNT, 1, 1 + cells, &seed);
        memcpy(nodes, ndl_rod_positions(rod), sizeof nodes);
        for (int i = 2; i < n - 1; i++) { /* on the edges between the old nodes */
            int k = (int)s[i];
            double f = s[i] - k;
            sb_vec3 a = ndl_rod_positions(rod)[k], b = ndl_rod_positions(rod)[k + 1 < n ? k + 1 : k];
            nodes[i] = sb_v3_add(sb_v3_scale(REAL(1 - f), a), sb_v3_scale(REAL(f), b));
        }
        CHECK_OK(ndl_rod_reparameterise(rod, nodes, n, NULL));
        CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
        for (int i = 1; i < n - 1; i++) {
            ndl_rod_curvature(rod, i, curvature);
            CHECK_NEAR((double)curvature[0] * radius, 1, 2e-3);
            CHECK_NEAR((double)curvature[1] * radius, -0.5, 2e-3);
        }
    }
    ndl_rod_destroy(rod);
}

/* Curve, rest curvature and stretch that change along the rod. */
static sb_vec3 on_curve(double s) { return sb_v3(REAL(s), REAL(0.05 * sin(12 * s)), REAL(3 * s * s * s)); }

/* Distance of the relaxed tips of a rod of n nodes made on the curve, and of one that went there by other nodes. */
static double relaxed_apart(int n)
{
    sb_vec3 nodes[MOST], other[MOST], tips[2];
    ndl_rod_def def = ndl_default_rod_def();
    double force = 3;
    for (int i = 0; i < n; i++) {
        double s = 0.2 * i / (n - 1), shift = i > 1 && i < n - 1 ? 0.2 * sin(9.0 * i / n) * 0.2 / (n - 1) : 0;
        nodes[i] = on_curve(s);
        other[i] = on_curve(s + shift);
    }
    def.node_count = n;
    def.rest = NDL_REST_SHAPE;
    for (int way = 0; way < 2; way++) {
        ndl_rod *rod;
        def.nodes = way ? nodes : other;
        rod = make_rod(&def);
        CHECK_OK(ndl_rod_reparameterise(rod, way ? other : nodes, n, NULL));
        if (way)
            CHECK_OK(ndl_rod_reparameterise(rod, nodes, n, NULL));
        CHECK_OK(ndl_rod_set_force(rod, n - 1, sb_v3(0, 0, REAL(force))));
        CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
        ndl_rod_tip(rod, &tips[way], NULL);
        ndl_rod_destroy(rod);
    }
    return (double)sb_v3_norm(sb_v3_sub(tips[0], tips[1]));
}

static void test_convergence(void)
{
    double coarse = relaxed_apart(21), middle = relaxed_apart(41), fine = relaxed_apart(81);
    CHECK(fine < (SB_REAL_IS_FLOAT ? 1e-5 : 2e-6));
    CHECK(SB_REAL_IS_FLOAT || coarse / middle > 4); /* second order at least; 7.2 and 7.8 measured */
    CHECK(SB_REAL_IS_FLOAT || middle / fine > 4);
}

static void test_motion(void)
{
    unsigned long long seed = 8;
    for (int clamped = 0; clamped < 2; clamped++) {
        ndl_rod *rod = wire(20, 40, 0, clamped);
        sb_vec3 velocities[40], nodes[40];
        double before[3], after[3], size = 0;
        for (int i = 0; i < 20; i++)
            velocities[i] =
                i < 2 && clamped ? sb_v3(0, 0, 0) : sb_v3(1, REAL(check_random_in(&seed, -1, 1)), REAL(0.1 * i));
        CHECK_OK(ndl_rod_set_velocities(rod, velocities));
        momentum(rod, before);
        for (int i = 0; i < 31; i++) {
            double at = i < 2 ? 0.2 * i / 19 : 0.2 / 19 + (0.2 - 0.2 / 19) * (i - 1) / 29;
            nodes[i] = sb_v3(REAL(at), REAL(2 * at * at), REAL(8 * at * at * at));
        }
        CHECK_OK(ndl_rod_reparameterise(rod, nodes, 31, NULL));
        momentum(rod, after);
        for (int k = 0; k < 3; k++)
            size = fmax(size, fabs(before[k]));
        for (int k = 0; k < 3; k++)
            CHECK_NEAR((after[k] - before[k]) / size, 0, scene_tolerance(1e-13, 100));
        if (clamped)
            CHECK(ndl_rod_velocities(rod)[0].x == 0 && ndl_rod_velocities(rod)[1].x == 0);
        else
            CHECK_NEAR((double)ndl_rod_velocities(rod)[11].x, 1, scene_tolerance(1e-13, 100)); /* was everywhere */
        CHECK_NEAR((double)ndl_rod_velocities(rod)[15].z, 0.1 * (1 + 18 * 14 / 29.0), 0.05);
        ndl_rod_destroy(rod);
    }
}

/* Nodes pushed together at one end: where Akima's lengths would fold over, linear ones do not. */
static void test_monotone(void)
{
    sb_vec3 nodes[40], squeezed[12];
    ndl_rod_def def = ndl_default_rod_def();
    ndl_rod *rod;
    double whole;
    def.nodes = nodes;
    def.node_count = 12;
    def.capacity = 40;
    def.clamped = 0;
    for (int i = 0; i < 12; i++) {
        nodes[i] = sb_v3(REAL(0.01 * i), 0, 0);
        squeezed[i] = sb_v3(REAL(i < 5 ? 0.01 * i : i < 7 ? 0.04 + 0.0001 * (i - 4) : 0.0402 + 0.03 * (i - 6)), 0, 0);
    }
    rod = make_rod(&def);
    whole = total_length(rod);
    CHECK_OK(ndl_rod_set_positions(rod, squeezed, NULL)); /* lengths jump by 1 : 100 : 3 */
    for (int i = 0; i < 40; i++)
        nodes[i] = sb_v3(REAL((double)squeezed[11].x * i / 39), 0, 0);
    CHECK_OK(ndl_rod_reparameterise(rod, nodes, 40, NULL));
    for (int j = 0; j < 39; j++)
        CHECK((double)ndl_rod_rest_length(rod, j) > 0.2 * (double)nodes[1].x);
    CHECK_NEAR(total_length(rod) / whole, 1, scene_tolerance(1e-13, 100));
    ndl_rod_destroy(rod);
}

/* The base stays clamped as it was, all else that held or pulled is gone, and the rod can go on. */
static void test_supports(void)
{
    ndl_rod *rod = wire(10, 20, 0, 1);
    sb_vec3 nodes[20], base[2], force;
    ndl_frame frame = ndl_rod_frame(rod, 0), now;
    double length = (double)ndl_rod_rest_length(rod, 0);
    memcpy(base, ndl_rod_positions(rod), sizeof base);
    for (int i = 0; i < 15; i++) {
        double at = i < 2 ? 0.2 * i / 9 : 0.2 / 9 + (0.2 - 0.2 / 9) * (i - 1) / 13;
        nodes[i] = sb_v3(REAL(at), REAL(2 * at * at), REAL(8 * at * at * at));
    }
    CHECK_OK(ndl_rod_hold(rod, 9, ndl_rod_positions(rod)[9], NULL));
    CHECK_OK(ndl_rod_set_force(rod, 5, sb_v3(0, 100, 0)));
    CHECK_OK(ndl_rod_turn(rod, 8, 1));
    CHECK_OK(ndl_rod_turn(rod, 0, REAL(0.5)));
    CHECK_OK(ndl_rod_set_torque(rod, 4, 1));
    CHECK_OK(ndl_rod_reparameterise(rod, nodes, 15, NULL));
    CHECK_NEAR((double)ndl_rod_rest_length(rod, 0) / length, 1, scene_tolerance(1e-15, 10));
    now = ndl_rod_frame(rod, 0);
    CHECK_NEAR((double)sb_v3_norm(sb_v3_sub(now.m1, frame.m1)), 0, scene_tolerance(1e-13, 10));
    CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
    CHECK(memcmp(base, ndl_rod_positions(rod), sizeof base) == 0);
    now = ndl_rod_frame(rod, 0);
    CHECK_NEAR((double)sb_v3_dot(now.m1, frame.m1), cos(0.5), scene_tolerance(1e-12, 10)); /* the turn was still due */
    force = ndl_rod_reactions(rod)[14];
    CHECK(force.x == 0 && force.y == 0 && force.z == 0);
    for (int i = 1; i < 14; i++) { /* nothing bends or twists it: straight along the clamp */
        sb_real curvature[2];
        ndl_rod_curvature(rod, i, curvature);
        CHECK_NEAR(hypot((double)curvature[0], (double)curvature[1]), 0, scene_tolerance(1e-6, 1e3));
        CHECK_NEAR((double)ndl_rod_twist(rod, i), 0, scene_tolerance(1e-9, 10));
    }
    ndl_rod_destroy(rod);
}

static void test_refusals(void)
{
    ndl_rod *rod = wire(8, 10, 1, 1);
    sb_vec3 nodes[12], good[8], velocities[8];
    sb_error error;
    ndl_rod_energy was = ndl_rod_energies(rod), is;
    double nothing = 0;
    memcpy(good, ndl_rod_positions(rod), sizeof good);
    memcpy(velocities, ndl_rod_velocities(rod), sizeof velocities);
    for (int i = 0; i < 12; i++)
        nodes[i] = good[i < 7 ? i : 7];
    CHECK_RESULT(ndl_rod_reparameterise(NULL, good, 8, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_reparameterise(rod, NULL, 8, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_reparameterise(rod, good, 1, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_reparameterise(rod, good, -3, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_reparameterise(rod, nodes, 11, &error), SB_ERROR_UNSUPPORTED);
    check_bad_numbers();
    nodes[3].y = REAL(1 / nothing);
    CHECK_RESULT(ndl_rod_reparameterise(rod, nodes, 8, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.node, 3);
    nodes[3] = nodes[2];
    CHECK_RESULT(ndl_rod_reparameterise(rod, nodes, 8, &error), SB_ERROR_MESH);
    CHECK_INT(error.node, 3);
    nodes[3] = good[3];
    nodes[6] = sb_v3_add(good[4], sb_v3_scale(REAL(1e-3), sb_v3_sub(good[4], good[5]))); /* back over edge 4 */
    CHECK_RESULT(ndl_rod_reparameterise(rod, nodes, 8, &error), SB_ERROR_MESH);
    CHECK_INT(error.node, 5);
    for (int i = 0; i < 8; i++) /* turned over as a whole: frames could not follow */
        nodes[i] = sb_v3_sub(sb_v3_scale(2, good[0]), good[i]);
    CHECK_RESULT(ndl_rod_reparameterise(rod, nodes, 8, &error), SB_ERROR_MESH);
    CHECK_INT(error.node, 1);
    for (int i = 0; i < 8; i++) /* shrunk to a point, nearly */
        nodes[i] = sb_v3_add(good[0], sb_v3_scale(REAL(1e-5), sb_v3_sub(good[i], good[0])));
    CHECK_RESULT(ndl_rod_reparameterise(rod, nodes, 8, &error), SB_ERROR_MESH);
    CHECK_INT(ndl_rod_node_count(rod), 8);
    CHECK(memcmp(good, ndl_rod_positions(rod), sizeof good) == 0);
    CHECK(memcmp(velocities, ndl_rod_velocities(rod), sizeof velocities) == 0);
    is = ndl_rod_energies(rod);
    CHECK(memcmp(&was, &is, sizeof was) == 0);
    ndl_rod_destroy(rod);
}

/* The same, told in other units of length and mass. */
static void test_scales(void)
{
    static const double scales[3] = {1e-3, 1, 1e3};
    double found[3];
    for (int k = 0; k < 3; k++) {
        sb_vec3 nodes[30];
        sb_real curvature[2];
        ndl_rod_def def = ndl_default_rod_def();
        ndl_rod *rod;
        def.section.radius *= REAL(scales[k]);
        for (int i = 0; i < 30; i++)
            nodes[i] = sb_v3_scale(REAL(scales[k]), on_curve(0.2 * i / 29));
        def.nodes = nodes;
        def.node_count = 30;
        def.rest = NDL_REST_SHAPE;
        rod = make_rod(&def);
        for (int i = 0; i < 17; i++)
            nodes[i] = sb_v3_scale(REAL(scales[k]), on_curve(0.2 * i / 16));
        CHECK_OK(ndl_rod_reparameterise(rod, nodes, 17, NULL));
        CHECK_OK(ndl_rod_solve_static(rod, NULL, NULL));
        ndl_rod_curvature(rod, 8, curvature);
        found[k] = hypot((double)curvature[0], (double)curvature[1]) * scales[k];
        ndl_rod_destroy(rod);
    }
    CHECK_NEAR(found[0] / found[1], 1, scene_tolerance(1e-7, 1e3));
    CHECK_NEAR(found[2] / found[1], 1, scene_tolerance(1e-7, 1e3));
}

CHECK_SUITE(rod_reshape, {"its own nodes change nothing", test_identity},
            {"arcs keep radius, rest curvature and length", test_arcs},
            {"a rest curvature out of a clamp", test_curvature}, {"errors fall with the edges", test_convergence},
            {"momentum, and what was uniform", test_motion}, {"lengths stay above 0", test_monotone},
            {"supports", test_supports}, {"refusals", test_refusals}, {"the same at every scale", test_scales});
