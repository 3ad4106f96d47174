/* Cables: ligaments, sutures, tethers. What one does is compared with its energy by differences, at random, and with
 * closed forms; balance, undo, states, recordings and changes of the mesh with what holds for every load. */
#define SB_SPLIT_BUILD
#include "../src/softbody/body/body_private.h"
#include "../src/softbody/body/cable.h"
#include "../src/softbody/body/cable_law.h"
#include "../src/softbody/body/load.h"
#include "../src/softbody/body/record.h"
#include "../src/softbody/body/state.h"

#include "check.h"
#include "random_case.h"

enum { MOST_POINTS = 5, MOST_ENTRIES = 4 * MOST_POINTS };

/* ---- one cable against its energy ---- */

typedef struct random_cable {
    int start[MOST_POINTS + 1], nodes[MOST_ENTRIES];
    sb_real weights[MOST_ENTRIES];
    sb_vec3 places[MOST_POINTS];
    sb_mapping rows;
    sb_cable_def def;
} random_cable;

static sb_vec3 random_vector(unsigned long long *seed, double size)
{
    return sb_v3(REAL(check_random_in(seed, -size, size)), REAL(check_random_in(seed, -size, size)),
                 REAL(check_random_in(seed, -size, size)));
}

/* Through nodes, mixes of nodes and places, at least one of them the body's. */
static void make_cable(unsigned long long *seed, const sb_mesh *mesh, double size, random_cable *c)
{
    int end = 0, count = 2 + random_below(seed, MOST_POINTS - 1);
    memset(c, 0, sizeof *c);
    for (int k = 0; k < count; k++) {
        int entries = k == 0 ? 1 : random_below(seed, 5);
        double sum = 0;
        c->places[k] = random_vector(seed, 2 * size);
        for (int i = 0; i < entries; i++) {
            c->nodes[end + i] = random_below(seed, mesh->node_count);
            c->weights[end + i] = REAL(check_random_in(seed, 0.1, 1));
            sum += (double)c->weights[end + i];
        }
        for (int i = 0; i < entries; i++)
            c->weights[end + i] = REAL((double)c->weights[end + i] / sum);
        end += entries;
        c->start[k + 1] = end;
    }
    c->rows.row_count = count;
    c->rows.row_start = c->start;
    c->rows.nodes = c->nodes;
    c->rows.weights = c->weights;
    c->def = sb_default_cable_def();
    c->def.count = count;
    c->def.rows = &c->rows;
    c->def.places = c->places;
    c->def.stiffness = REAL(random_scale(seed, 1, 1e3));
    c->def.toe_strain = random_below(seed, 2) ? REAL(check_random_in(seed, 0.01, 0.3)) : 0;
    c->def.pushes = random_below(seed, 2);
}

static sb_body *plain_body(const sb_mesh *mesh)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = sb_material_corotated(REAL(1e4), REAL(0.3), 1000);
    return scene_body(&def);
}

static double energy_at(sb_body *body, const sb_vec3 *u) { return sbi_loads_curved_energy(body, u, 1); }

/* Force = - slope of the energy and stiffness = - slope of the force along random d, product = matrix times d. */
static void test_law(void)
{
    unsigned long long seed = 41;
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("differences need double");
        return;
    }
    for (int round = 0; round < check_rounds(60); round++) {
        double size = pow(10, 3 * (round % 3) - 3), step = 1e-6 * size;
        sb_mesh mesh =
            scene_box(round % 2 ? SB_TET10 : SB_HEX8, 2, 2, 1, sb_v3(REAL(size), REAL(size), REAL(size / 2)), 0.2);
        sb_body *body = plain_body(&mesh);
        int n = mesh.node_count, id = 0;
        sb_vec3 *u = (sb_vec3 *)calloc(4 * (size_t)n, sizeof *u), *d = u + n, *moved = d + n, *product = moved + n;
        random_cable c;
        double slope[3] = {0, 0, 0}, force[2], largest = 0;
        make_cable(&seed, &mesh, size, &c);
        if (!CHECK_OK(sb_body_add_cable(body, &c.def, &id, NULL)))
            continue;
        {
            sb_real length = 0;
            CHECK_OK(sb_body_cable_length(body, id, &length));
            CHECK_OK(sb_body_set_cable_rest_length(body, id, length * REAL(check_random_in(&seed, 0.6, 1.1))));
        }
        for (int i = 0; i < n; i++) {
            u[i] = random_vector(&seed, 0.1 * size);
            d[i] = random_vector(&seed, 1);
        }
        for (int side = 0; side < 2; side++) {
            double sign = side ? 1 : -1;
            for (int i = 0; i < n; i++)
                moved[i] = sb_v3_madd(u[i], REAL(sign * step), d[i]);
            slope[0] += sign * energy_at(body, moved) / (2 * step);
            sbi_loads_force(body, moved, 1);
            force[side] = 0;
            for (int i = 0; i < n; i++) {
                product[i] = sb_v3_madd(product[i], REAL(-sign / (2 * step)), body->follower[i]);
                largest = fmax(largest, (double)sb_v3_norm(body->follower[i]));
            }
        }
        sbi_loads_force(body, u, 1);
        for (int i = 0; i < n; i++)
            slope[1] += (double)sb_v3_dot(body->follower[i], d[i]);
        CHECK_NEAR(slope[1], -slope[0], 1e-7 * largest * n);
        sb_matrix_clear(&body->matrix);
        sbi_loads_add_tangent(body, u, SB_TANGENT_EXACT, 1, &body->matrix);
        sb_matrix_multiply(&body->matrix, &d[0].x, &moved[0].x, NULL);
        CHECK_NEAR(scene_distance(moved, product, n), 0, 2e-5 * largest / size * n);
        sb_matrix_clear(&body->matrix);
        sbi_loads_add_tangent(body, u, SB_TANGENT_SPD, 1, &body->matrix);
        sb_matrix_multiply(&body->matrix, &d[0].x, &moved[0].x, NULL);
        for (int i = 0; i < n; i++)
            slope[2] += (double)sb_v3_dot(moved[i], d[i]);
        CHECK(slope[2] >= -1e-12 * largest / size * n);
        sbi_loads_subtract_product(body, d, 1, moved); /* K d - K d */
        CHECK_NEAR(sb_v3_norm(scene_sum(moved, n)), 0, 1e-10 * (largest / size + slope[2]));
        for (int i = 0; i < n; i++)
            CHECK_NEAR(sb_v3_norm(moved[i]), 0, 1e-10 * (largest / size + slope[2]));
        (void)force;
        free(u);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* ---- closed forms ---- */

/* A bar of one hex8 of nu 0, its end drawn by four cables in a row with it. */
typedef struct drawn_bar {
    sb_mesh mesh;
    sb_body *body;
    int ids[4], nodes[4];
    sb_vec3 places[4];
    double size, bar, cable; /* m; stiffness of a quarter of the bar and of one cable (N/m) */
} drawn_bar;

static int bar_make(drawn_bar *b, double size, double stiffness, int max_newton)
{
    sb_body_def def = sb_default_body_def();
    int count = 0;
    memset(b, 0, sizeof *b);
    b->size = size;
    b->mesh = scene_box(SB_HEX8, 1, 1, 1, sb_v3(REAL(2 * size), REAL(size), REAL(size)), 0);
    def.mesh = &b->mesh;
    def.material = sb_material_linear(REAL(1e4), 0, 1000);
    def.max_newton = max_newton;
    def.tolerance = REAL(scene_tolerance(1e-12, 64));
    b->body = scene_body(&def);
    scene_fix_plane(b->body, &b->mesh, 0, 0, SB_XYZ);
    b->bar = 1e4 * size * size / (2 * size) / 4;
    for (int i = 0; i < b->mesh.node_count; i++) {
        const int path[2] = {i, -1};
        sb_vec3 ends[2];
        sb_cable_def cable = sb_default_cable_def();
        if (b->mesh.nodes[i].x < REAL(size))
            continue;
        b->places[count] = ends[1] = sb_v3_add(b->mesh.nodes[i], sb_v3(REAL(0.5 * size), 0, 0));
        ends[0] = b->mesh.nodes[i];
        cable.count = 2;
        cable.nodes = path;
        cable.places = ends;
        cable.stiffness = REAL(stiffness);
        b->nodes[count] = i;
        CHECK_OK(sb_body_add_cable(b->body, &cable, b->ids + count++, NULL));
    }
    b->cable = stiffness / (0.5 * size);
    return CHECK_INT(count, 4);
}

static void bar_free(drawn_bar *b)
{
    sb_body_destroy(b->body);
    sb_mesh_free(&b->mesh);
}

static void bar_draw(drawn_bar *b, double way)
{
    for (int k = 0; k < 4; k++) {
        const sb_vec3 ends[2] = {sb_v3(0, 0, 0), sb_v3_add(b->places[k], sb_v3(REAL(way), 0, 0))};
        CHECK_OK(sb_body_move_cable(b->body, b->ids[k], ends));
    }
}

/* Two springs in a row, at three sizes; and slack, which leaves no trace. */
static void test_series(void)
{
    for (int scale = -3; scale <= 3; scale += 3) {
        double size = pow(10, scale), way = 0.02 * size, tension;
        sb_static_options options = sb_default_static_options();
        drawn_bar b;
        if (!bar_make(&b, size, 300 * size * size, 1))
            return;
        options.tolerance = REAL(scene_tolerance(1e-12, 32));
        bar_draw(&b, way);
        CHECK_OK(sb_body_solve_static(b.body, &options, NULL));
        tension = way * b.bar * b.cable / (b.bar + b.cable);
        for (int k = 0; k < 4; k++) {
            sb_real read = 0;
            sb_vec3 forces[2];
            CHECK_OK(sb_body_cable_tension(b.body, b.ids[k], &read));
            CHECK_NEAR(read, tension, scene_tolerance(1e-9, 1e4) * tension);
            CHECK_OK(sb_body_cable_forces(b.body, b.ids[k], forces));
            CHECK_NEAR(forces[0].x, tension, scene_tolerance(1e-9, 1e4) * tension);
            CHECK_NEAR(forces[1].x, -tension, scene_tolerance(1e-9, 1e4) * tension);
            CHECK_NEAR(sb_body_displacements(b.body)[b.nodes[k]].x, tension / b.bar, scene_tolerance(1e-9, 1e4) * way);
        }
        bar_draw(&b, -way);
        CHECK_OK(sb_body_solve_static(b.body, &options, NULL));
        for (int k = 0; k < 4; k++) {
            sb_real read = 1;
            CHECK_OK(sb_body_cable_tension(b.body, b.ids[k], &read));
            CHECK(read == 0);
            CHECK_NEAR(sb_body_displacements(b.body)[b.nodes[k]].x, 0, scene_tolerance(1e-9, 1e3) * way);
        }
        bar_free(&b);
    }
}

/* A toe: tension stiffness e^2 / (2 toe), then stiffness (e - toe / 2); both ends held. */
static void test_toe(void)
{
    static const double strains[] = {-0.1, 0.0, 0.02, 0.05, 0.2};
    sb_mesh mesh = scene_box(SB_HEX8, 1, 1, 1, sb_v3(1, 1, 1), 0);
    sb_body *body = plain_body(&mesh);
    const int path[2] = {0, -1};
    const double stiffness = 70, toe = 0.05;
    for (int i = 0; i < mesh.node_count; i++)
        CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_XYZ));
    for (int pushes = 0; pushes < 2; pushes++)
        for (int k = 0; k < 5; k++) {
            double e = strains[k], size = fabs(e), law = size < toe ? size * size / (2 * toe) : size - toe / 2;
            double wanted = e > 0 ? stiffness * law : pushes ? -stiffness * law : 0;
            sb_vec3 ends[2] = {mesh.nodes[0], sb_v3_add(mesh.nodes[0], sb_v3(REAL(1 + e), 0, 0))};
            sb_cable_def def = sb_default_cable_def();
            sb_real read = 0, length = 0;
            sb_vec3 force;
            int id = 0;
            def.count = 2, def.nodes = path, def.places = ends;
            def.rest_length = 1, def.stiffness = REAL(stiffness), def.toe_strain = REAL(toe), def.pushes = pushes;
            CHECK_OK(sb_body_add_cable(body, &def, &id, NULL));
            CHECK_OK(sb_body_solve_static(body, NULL, NULL));
            CHECK_OK(sb_body_cable_tension(body, id, &read));
            CHECK_OK(sb_body_cable_length(body, id, &length));
            CHECK_OK(sb_body_load_force(body, id, sb_v3(0, 0, 0), &force, NULL));
            CHECK_NEAR(read, wanted, scene_tolerance(1e-12, 64) * stiffness);
            CHECK_NEAR(force.x, wanted, scene_tolerance(1e-12, 64) * stiffness);
            CHECK_NEAR(length, 1 + e, scene_tolerance(1e-14, 8));
            CHECK_OK(sb_body_remove_load(body, id));
            CHECK_RESULT(sb_body_cable_tension(body, id, &read), SB_ERROR_INDEX);
        }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* A block that hangs on a thread from two hooks through its top, which slides: the same tension on both sides, and
 * 2 N h / l is its weight. */
static void test_thread(void)
{
    for (int scale = -3; scale <= 3; scale += 3) {
        double size = pow(10, scale), gravity = 9.81, mass = 1000 * size * size * size;
        sb_mesh mesh = scene_box(SB_HEX8, 2, 2, 2, sb_v3(REAL(size), REAL(size), REAL(size)), 0);
        sb_body_def body_def = sb_default_body_def();
        sb_body *body;
        sb_static_options options = sb_default_static_options();
        sb_cable_def def = sb_default_cable_def();
        int path[3] = {-1, -1, -1}, id = 0;
        sb_vec3 places[3], forces[3], at[3], first, last;
        sb_real tension = 0;
        body_def.mesh = &mesh;
        body_def.material = sb_material_corotated(REAL(1e5 * size), REAL(0.3), 1000);
        body_def.gravity = sb_v3(0, 0, REAL(-gravity));
        body = scene_body(&body_def);
        for (int i = 0; i < mesh.node_count; i++) {
            sb_vec3 x = mesh.nodes[i];
            if (fabs((double)x.z - size) < 1e-6 * size && fabs((double)x.x - 0.5 * size) < 1e-6 * size &&
                fabs((double)x.y - 0.5 * size) < 1e-6 * size)
                path[1] = i;
            if (i != path[1] && fabs((double)x.x - 0.5 * size) > 0.1 * size) /* so that it neither turns nor swings */
                CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_X | SB_Y));
        }
        if (!CHECK(path[1] >= 0))
            return;
        places[0] = sb_v3(REAL(-0.7 * size), REAL(0.5 * size), REAL(1.6 * size));
        places[1] = sb_v3(0, 0, 0);
        places[2] = sb_v3(REAL(2.2 * size), REAL(0.5 * size), REAL(1.9 * size));
        def.count = 3, def.nodes = path, def.places = places;
        def.stiffness = REAL(50 * mass * gravity);
        CHECK_OK(sb_body_add_cable(body, &def, &id, NULL));
        options.tolerance = REAL(scene_tolerance(1e-11, 64));
        options.max_newton = 100;
        sb_step_info info;
        if (!CHECK_OK(sb_body_solve_static(body, &options, &info))) {
            printf("%s\n", info.error.message);
            return;
        }
        CHECK_OK(sb_body_cable_tension(body, id, &tension));
        CHECK_OK(sb_body_cable_forces(body, id, forces));
        CHECK_OK(sb_body_cable_points(body, id, at));
        first = sb_v3_sub(at[0], at[1]), last = sb_v3_sub(at[2], at[1]);
        CHECK_NEAR(sb_v3_norm(forces[0]), tension, scene_tolerance(1e-12, 64) * (double)tension);
        CHECK_NEAR(sb_v3_norm(forces[2]), tension, scene_tolerance(1e-12, 64) * (double)tension);
        CHECK_NEAR((double)tension *
                       ((double)first.z / (double)sb_v3_norm(first) + (double)last.z / (double)sb_v3_norm(last)),
                   mass * gravity, scene_tolerance(1e-8, 1e4) * mass * gravity);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* ---- motion ---- */

static sb_body *tied_body(const sb_mesh *mesh, sb_integrator integrator, int max_newton, const sb_jobs *jobs)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = sb_material_corotated(REAL(2e4), REAL(0.3), 1000);
    def.integrator = integrator;
    def.max_newton = max_newton;
    def.tolerance = REAL(scene_tolerance(1e-10, 16));
    if (jobs)
        def.jobs = *jobs;
    return scene_body(&def);
}

/* A cable within the body, another to a place; tight. */
static void tie(sb_body *body, const sb_mesh *mesh, int to_space, int ids[2])
{
    const int within[3] = {0, mesh->node_count / 2, mesh->node_count - 1}, out[2] = {mesh->node_count / 3, -1};
    sb_vec3 places[2] = {sb_v3(0, 0, 0), sb_v3(REAL(0.3), 2, REAL(0.4))};
    sb_cable_def def = sb_default_cable_def();
    sb_real length = 0;
    def.count = 3, def.nodes = within, def.stiffness = 200;
    CHECK_OK(sb_body_add_cable(body, &def, ids, NULL));
    CHECK_OK(sb_body_cable_length(body, ids[0], &length));
    CHECK_OK(sb_body_set_cable_rest_length(body, ids[0], REAL(0.8) * length));
    def.count = 2, def.nodes = out, def.places = places, def.toe_strain = REAL(0.02);
    if (to_space)
        CHECK_OK(sb_body_add_cable(body, &def, ids + 1, NULL));
}

/* Momenta of a free body stay when a cable within it pulls; with one to a place, momentum rises by what it reads. */
static void test_momentum(void)
{
    static const sb_integrator integrators[] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA, SB_CENTRAL_DIFFERENCE};
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(1, REAL(0.6), REAL(0.5)), 0.2);
    for (int k = 0; k < 8; k++) {
        sb_integrator integrator = integrators[k / 2];
        sb_body *body = tied_body(&mesh, integrator, k % 2 ? 1 : 20, NULL);
        sb_energy energy = {0, 0, 0};
        int ids[2];
        tie(body, &mesh, 0, ids);
        for (int step = 0; step < 20; step++)
            CHECK_OK(sb_body_step(body, REAL(0.005), NULL));
        CHECK_OK(sb_body_energy(body, &energy));
        CHECK(energy.kinetic > REAL(1e-3));
        CHECK_NEAR(sb_v3_norm(sb_body_momentum(body)), 0,
                   scene_tolerance(1e-7, 1e5) * sqrt(2 * (double)energy.kinetic * (double)sb_body_mass(body)));
        sb_body_destroy(body);
    }
    sb_mesh_free(&mesh);
}

/* What a cable to a place pulls with is what momentum rises by, step by step: also in linearised steps, whose force is
 * that of the balance and not of where they began. */
static void test_pull(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(1, REAL(0.6), REAL(0.5)), 0.2);
    const double dt = 0.004;
    for (int iterated = 0; iterated < 2; iterated++) {
        sb_body *body = tied_body(&mesh, SB_EULER, iterated ? 20 : 1, NULL);
        sb_vec3 before = sb_v3(0, 0, 0), force;
        double pulled = 0;
        int ids[2];
        tie(body, &mesh, 1, ids);
        for (int step = 0; step < 30; step++) {
            const sb_vec3 places[2] = {sb_v3(0, 0, 0), sb_v3(REAL(0.3), REAL(2 + 0.02 * step), REAL(0.4))};
            sb_vec3 forces[2], gained;
            CHECK_OK(sb_body_move_cable(body, ids[1], places));
            CHECK_OK(sb_body_step(body, REAL(dt), NULL));
            CHECK_OK(sb_body_load_force(body, ids[1], sb_v3(0, 0, 0), &force, NULL));
            CHECK_OK(sb_body_cable_forces(body, ids[1], forces));
            CHECK_NEAR(scene_distance(&force, forces, 1), 0, scene_tolerance(1e-12, 64) * (double)sb_v3_norm(force));
            gained = sb_v3_sub(sb_body_momentum(body), before);
            before = sb_body_momentum(body);
            pulled = fmax(pulled, (double)sb_v3_norm(force));
            CHECK_NEAR(sb_v3_norm(sb_v3_madd(gained, REAL(-dt), force)), 0,
                       scene_tolerance(1e-6, 1e5) * dt * (pulled + 1));
        }
        CHECK(pulled > 1);
        sb_body_destroy(body);
    }
    sb_mesh_free(&mesh);
}

/* Central differences count a stiff cable while it is slack: a body thrown into it bounces, and gains no energy. */
static void test_explicit(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 2, 2, 2, sb_v3(1, 1, 1), 0.2);
    sb_body *body = tied_body(&mesh, SB_CENTRAL_DIFFERENCE, 1, NULL);
    const int path[2] = {mesh.node_count / 2, -1};
    sb_vec3 places[2], *kick = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof *kick);
    sb_cable_def def = sb_default_cable_def();
    sb_energy energy = {0, 0, 0};
    double first, most = 0, taut = 0;
    int id = 0;
    places[0] = sb_v3(0, 0, 0), places[1] = sb_v3_add(mesh.nodes[path[0]], sb_v3(-1, 0, 0));
    def.count = 2, def.nodes = path, def.places = places, def.rest_length = REAL(1.2), def.stiffness = 1e6;
    CHECK_OK(sb_body_add_cable(body, &def, &id, NULL));
    for (int i = 0; i < mesh.node_count && CHECK(kick); i++)
        kick[i] = sb_v3(1, 0, 0);
    CHECK_OK(sb_body_set_velocities(body, kick));
    CHECK_OK(sb_body_energy(body, &energy));
    first = (double)energy.kinetic;
    for (int step = 0; step < 60; step++) {
        sb_real tension = 0;
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        CHECK_OK(sb_body_energy(body, &energy));
        CHECK_OK(sb_body_cable_tension(body, id, &tension));
        taut += tension > 0;
        most = fmax(most, (double)(energy.kinetic + energy.elastic + energy.springs));
    }
    CHECK(taut > 0);
    CHECK(most < 1.04 * first); /* 1.02: what is read at a step's end is not quite the scheme's energy */
    CHECK(sb_body_momentum(body).x < REAL(0.9) * sb_body_mass(body));
    free(kick);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* Energy that is neither made nor lost beyond the scheme's: Newmark, iterated, over many swings of a free body whose
 * cable goes slack and taut. */
static void test_energy(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(1, REAL(0.6), REAL(0.5)), 0.2);
    sb_body *body = tied_body(&mesh, SB_NEWMARK, 30, NULL);
    sb_energy energy;
    double first, low = 1e30, high = 0, slack = 0;
    int ids[2];
    tie(body, &mesh, 0, ids);
    {
        sb_real length = 0;
        CHECK_OK(sb_body_cable_length(body, ids[0], &length));
        CHECK_OK(sb_body_set_cable_rest_length(body, ids[0], REAL(0.9) * length));
        CHECK_OK(sb_body_set_cable_stiffness(body, ids[0], 4000));
    }
    CHECK_OK(sb_body_energy(body, &energy));
    first = (double)(energy.springs + energy.kinetic + energy.elastic);
    CHECK(energy.springs > 0);
    for (int step = 0; step < 150; step++) {
        sb_real tension = 0;
        CHECK_OK(sb_body_step(body, REAL(0.002), NULL));
        CHECK_OK(sb_body_energy(body, &energy));
        CHECK_OK(sb_body_cable_tension(body, ids[0], &tension));
        slack += tension == 0;
        low = fmin(low, (double)(energy.springs + energy.kinetic + energy.elastic));
        high = fmax(high, (double)(energy.springs + energy.kinetic + energy.elastic));
    }
    CHECK(slack > 10);
    CHECK(high < 1.02 * first && low > 0.98 * first);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- undo, state, recording ---- */

static void swing(sb_body *body, const int ids[2], int steps)
{
    for (int step = 0; step < steps; step++) {
        const sb_vec3 places[2] = {sb_v3(0, 0, 0), sb_v3(REAL(0.3 + 0.02 * step), 2, REAL(0.4))};
        CHECK_OK(sb_body_move_cable(body, ids[1], places));
        if (step == 3)
            CHECK_OK(sb_body_set_cable_stiffness(body, ids[0], 300));
        CHECK_OK(sb_body_step(body, REAL(0.005), NULL));
    }
}

static void test_state(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(1, REAL(0.6), REAL(0.5)), 0.2);
    sb_body *body = tied_body(&mesh, SB_NEWMARK, 20, NULL), *other = tied_body(&mesh, SB_NEWMARK, 20, NULL);
    size_t size;
    void *state, *ends[3];
    sb_recording *recording = NULL;
    sb_error error;
    int ids[2];
    sb_recording_report report;
    CHECK_OK(sb_recording_start(body, 1, NULL, &recording, &error));
    tie(body, &mesh, 1, ids);
    swing(body, ids, 4);
    size = sb_body_state_size(body);
    state = malloc(size);
    CHECK_OK(sb_body_state_save(body, state, size));
    swing(body, ids, 6);
    ends[0] = malloc(size), ends[1] = malloc(size), ends[2] = malloc(size);
    CHECK_OK(sb_body_state_save(body, ends[0], size));
    if (!CHECK_OK(sb_body_state_load(other, state, size, &error)))
        printf("%s\n", error.message);
    swing(other, ids, 6);
    CHECK_OK(sb_body_state_save(other, ends[1], size));
    CHECK(memcmp(ends[0], ends[1], size) == 0);
    check_bad_numbers();
    CHECK(sb_body_step(body, REAL(NAN), NULL) != SB_OK);
    CHECK_OK(sb_body_state_save(body, ends[2], size));
    CHECK(memcmp(ends[0], ends[2], size) == 0);
    sb_recording_stop(recording);
    if (!CHECK_OK(sb_recording_replay(recording, other, &report)))
        printf("step %d: %s\n", report.step, report.error.message);
    CHECK_INT(report.steps, 10);
    sb_recording_destroy(recording);
    free(state), free(ends[0]), free(ends[1]), free(ends[2]);
    sb_body_destroy(body);
    sb_body_destroy(other);
    sb_mesh_free(&mesh);
}

/* ---- changes of the mesh ---- */

/* Cells go around a cable's points: it stays where it is, and pulls as before. Where one of its points goes without an
 * heir, the change is refused, or the point is held by the nearest that stays. */
static void test_change(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 5, 4, 4, sb_v3(1, 1, 1), 0.2);
    sb_body *body = scene_changing_body(&mesh, sb_material_corotated(REAL(1e4), REAL(0.3), 1000));
    sb_vec3 before[3], after[3], forces[3];
    sb_real length[2], tension = 0;
    int ids[2];
    tie(body, &mesh, 1, ids);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_solve_static(body, NULL, NULL));
    CHECK_OK(sb_body_cable_points(body, ids[0], before));
    CHECK_OK(sb_body_cable_length(body, ids[0], length));
    scene_remove_cells(body);
    CHECK_OK(sb_body_cable_points(body, ids[0], after));
    CHECK_OK(sb_body_cable_length(body, ids[0], length + 1));
    CHECK_NEAR(scene_distance(before, after, 3), 0, scene_tolerance(1e-12, 64));
    CHECK_NEAR(length[0], length[1], scene_tolerance(1e-12, 64));
    CHECK_OK(sb_body_solve_static(body, NULL, NULL));
    CHECK_OK(sb_body_cable_tension(body, ids[0], &tension));
    CHECK_OK(sb_body_cable_forces(body, ids[0], forces));
    CHECK(tension > 0);
    CHECK_NEAR(sb_v3_norm(scene_sum(forces, 3)), 0, scene_tolerance(1e-12, 64) * (double)tension);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- random bodies ---- */

/* In any body what cables, loads and supports do sums to 0; and Newton's iterations are few, whatever the cable does.
 */
static void test_random(void)
{
    int solved = 0;
    for (int number = 1; number <= check_rounds(40); number++) {
        unsigned long long seed = 977ull * (unsigned long long)number;
        random_case c;
        sb_body *body;
        sb_body_def def = sb_default_body_def();
        sb_static_options options = sb_default_static_options();
        double size = 0;
        int ids[3], count = 0;
        sb_vec3 sum, low, high;
        if (!random_case_make(&c, (unsigned long long)number, 0))
            continue;
        sb_mesh_bounds(&c.mesh, &low, &high);
        def.mesh = &c.mesh;
        def.material = c.material;
        def.gravity = c.gravity;
        def.integration = c.integration;
        body = scene_body(&def);
        if (!body)
            continue;
        CHECK_OK(sb_body_fix_nodes(body, c.held, c.held_count, SB_XYZ));
        for (; count < 3; count++) {
            int path[3] = {random_below(&seed, c.mesh.node_count), random_below(&seed, c.mesh.node_count), -1};
            sb_vec3 places[3];
            sb_cable_def cable = sb_default_cable_def();
            sb_real length = 0;
            memset(places, 0, sizeof places);
            places[2] = sb_v3_madd(high, REAL(check_random(&seed)), sb_v3_sub(high, low));
            cable.count = 3, cable.nodes = path, cable.places = places;
            cable.stiffness = REAL(0.01) * sbi_body_young(body) * sb_v3_dot(sb_v3_sub(high, low), sb_v3_sub(high, low));
            cable.toe_strain = REAL(0.03) * REAL(random_below(&seed, 2));
            if (!CHECK_OK(sb_body_add_cable(body, &cable, ids + count, NULL)))
                break;
            CHECK_OK(sb_body_cable_length(body, ids[count], &length));
            CHECK_OK(sb_body_set_cable_rest_length(body, ids[count], length * REAL(check_random_in(&seed, 0.9, 1.05))));
        }
        options.tolerance = REAL(scene_tolerance(1e-9, 64));
        options.max_newton = 60;
        if (sb_body_solve_static(body, &options, NULL) == SB_OK) {
            solved++;
            sum = sb_v3_add(scene_sum(sb_body_reactions(body), c.mesh.node_count),
                            scene_sum(sb_body_external_forces(body), c.mesh.node_count));
            for (int i = 0; i < c.mesh.node_count; i++)
                size += (double)sb_v3_norm(sb_body_reactions(body)[i]) +
                        (double)sb_v3_norm(sb_body_external_forces(body)[i]);
            CHECK_NEAR(sb_v3_norm(sum), 0, scene_tolerance(1e-8, 3e4) * size);
        }
        sb_body_destroy(body);
        random_case_free(&c);
    }
    CHECK(solved >= check_rounds(40) * 9 / 10);
}

/* ---- errors ---- */

static void test_errors(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 1, 1, 1, sb_v3(1, 1, 1), 0);
    sb_body *body = plain_body(&mesh);
    const sb_vec3 places[2] = {sb_v3(0, 0, 0), sb_v3(2, 0, 0)}, bad[2] = {sb_v3(0, 0, 0), sb_v3(REAL(NAN), 0, 0)};
    const int path[2] = {0, -1}, none[2] = {-1, -1}, far_off[2] = {0, mesh.node_count}, twice[2] = {3, 3};
    sb_cable_def def = sb_default_cable_def();
    int id = -7;
    sb_real read = 5;
    uint64_t hash = sb_body_state_hash(body);
    sb_error error;
    def.count = 2, def.nodes = path, def.stiffness = 10;
    CHECK_RESULT(sb_body_add_cable(body, &def, &id, &error), SB_ERROR_ARGUMENT); /* a point without a place */
    CHECK_INT(error.element, 1);
    def.places = bad;
    check_bad_numbers();
    CHECK_RESULT(sb_body_add_cable(body, &def, &id, &error), SB_ERROR_NOT_FINITE);
    def.places = places, def.nodes = none;
    CHECK_RESULT(sb_body_add_cable(body, &def, &id, &error), SB_ERROR_ARGUMENT);
    def.nodes = far_off;
    CHECK_RESULT(sb_body_add_cable(body, &def, &id, &error), SB_ERROR_INDEX);
    def.nodes = twice;
    CHECK_RESULT(sb_body_add_cable(body, &def, &id, &error), SB_ERROR_ARGUMENT); /* no length */
    for (int k = 0; k < 3; k++) { /* half a node, a mean of two that is one and a half, a difference */
        static const int row_start[3] = {0, 2, 2}, nodes[2] = {0, 3};
        static const sb_real weights[3][2] = {{REAL(0.5), 0}, {REAL(0.75), REAL(0.75)}, {1, -1}};
        sb_mapping rows;
        memset(&rows, 0, sizeof rows);
        rows.row_count = 2, rows.row_start = row_start, rows.nodes = nodes, rows.weights = weights[k];
        def.nodes = NULL, def.rows = &rows;
        CHECK_RESULT(sb_body_add_cable(body, &def, &id, &error), SB_ERROR_ARGUMENT);
        CHECK_INT(error.element, 0);
        def.rows = NULL;
    }
    def.nodes = path, def.stiffness = -1;
    CHECK_RESULT(sb_body_add_cable(body, &def, &id, &error), SB_ERROR_ARGUMENT);
    def.stiffness = 1, def.rest_length = -1;
    CHECK_RESULT(sb_body_add_cable(body, &def, &id, &error), SB_ERROR_ARGUMENT);
    def.rest_length = 0, def.count = 1;
    CHECK_RESULT(sb_body_add_cable(body, &def, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_INT(id, -7);
    CHECK(sb_body_state_hash(body) == hash);
    def.count = 2;
    CHECK_OK(sb_body_add_cable(body, &def, &id, &error));
    CHECK_RESULT(sb_body_set_cable_rest_length(body, id, 0), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_set_cable_rest_length(body, id + 1, 1), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_set_cable_stiffness(body, id, REAL(NAN)), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_body_move_cable(body, id, bad), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_body_set_spring_stiffness(body, id, &read, 1), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_cable_tension(body, id + 1, &read), SB_ERROR_INDEX);
    CHECK(read == 5);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(cable, {"one cable against its energy", test_law}, {"springs in a row", test_series}, {"toe", test_toe},
            {"a thread that slides", test_thread}, {"momentum", test_momentum}, {"pull", test_pull},
            {"explicit", test_explicit}, {"energy", test_energy}, {"state and undo", test_state},
            {"change", test_change}, {"random bodies", test_random}, {"errors", test_errors});
