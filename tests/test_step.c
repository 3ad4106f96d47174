/* Time steps and static solves: closed forms, conservation, order, scale, undo, violence, threads. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

static const sb_element_type element_types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
enum { ELEMENT_TYPES = 5 };

/* ---- free bodies ---- */

static void test_free_fall(void)
{
    static const sb_mass_kind kinds[] = {SB_MASS_LUMPED, SB_MASS_CONSISTENT};
    for (int t = 0; t < ELEMENT_TYPES; t++)
        for (int k = 0; k < 4; k++) {
            sb_mesh mesh = scene_box(element_types[t], 2, 2, 2, sb_v3(REAL(0.1), REAL(0.1), REAL(0.1)), 0.1);
            sb_body_def def = sb_default_body_def();
            sb_body *body;
            double fallen, v;
            def.mesh = &mesh;
            def.material = sb_material_corotated(REAL(5e3), REAL(0.4), REAL(1000));
            def.gravity = sb_v3(0, 0, REAL(-9.81));
            def.mass = kinds[k / 2];
            def.integrator = k % 2 ? SB_NEWMARK : SB_EULER;
            def.tolerance = REAL(1e-6);
            body = scene_body(&def);
            for (int s = 0; s < 10; s++)
                CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
            v = -9.81 * 0.1;
            fallen = k % 2 ? -9.81 * 0.005 : -9.81 * 0.01 * 0.01 * 55;
            for (int i = 0; i < mesh.node_count; i++) {
                CHECK_NEAR(sb_body_velocities(body)[i].z, v, 1e-5);
                CHECK_NEAR(sb_body_displacements(body)[i].z, fallen, 1e-6);
                CHECK_NEAR(sb_body_displacements(body)[i].x, 0, 1e-6);
            }
            sb_body_destroy(body);
            sb_mesh_free(&mesh);
        }
}

static void test_rest(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++)
        for (int newmark = 0; newmark < 2; newmark++) {
            sb_mesh mesh = scene_box(element_types[t], 2, 1, 1, sb_v3(REAL(0.2), REAL(0.1), REAL(0.1)), 0);
            sb_body_def def = sb_default_body_def();
            sb_body *body;
            int node = 0, steps = check_quick() ? 500 : 10000;
            for (int i = 0; i < mesh.node_count; i++) /* far from the origin, as scanner coordinates are */
                mesh.nodes[i] = sb_v3_add(mesh.nodes[i], sb_v3(100, -200, 300));
            def.mesh = &mesh;
            def.material = sb_material_corotated(REAL(5e3), REAL(0.45), REAL(1000));
            def.integrator = newmark ? SB_NEWMARK : SB_EULER;
            body = scene_body(&def);
            CHECK_OK(sb_body_fix_nodes(body, &node, 1, SB_XYZ));
            for (int s = 0; s < steps; s++)
                if (!CHECK_OK(sb_body_step(body, REAL(0.01), NULL)))
                    break;
            CHECK_NEAR(scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count), 0, 0);
            sb_body_destroy(body);
            sb_mesh_free(&mesh);
        }
}

/* ---- conservation ---- */

static void test_newmark_keeps_energy(void)
{
    int steps = check_quick() ? 100 : 1000;
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        sb_mesh mesh = scene_box(element_types[t], 3, 1, 1, sb_v3(REAL(0.2), REAL(0.06), REAL(0.06)), 0.1);
        sb_body_def def = sb_default_body_def();
        sb_energy energy;
        double first = 0, worst = 0;
        sb_vec3 *v = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof(sb_vec3));
        sb_body *body;
        def.mesh = &mesh;
        def.material = sb_material_linear(REAL(5e4), REAL(0.3), REAL(1000));
        def.integrator = SB_NEWMARK;
        def.mass = SB_MASS_CONSISTENT;
        def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-8);
        def.max_iterations = 2000;
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        for (int i = 0; i < mesh.node_count; i++)
            v[i].z = 10 * mesh.nodes[i].x * mesh.nodes[i].x;
        CHECK_OK(sb_body_set_velocities(body, v));
        for (int s = 0; s < steps; s++) {
            double total;
            if (!CHECK_OK(sb_body_step(body, REAL(0.005), NULL)))
                break;
            CHECK_OK(sb_body_energy(body, &energy));
            total = (double)energy.elastic + (double)energy.kinetic;
            if (s == 0)
                first = total;
            if (fabs(total - first) > worst)
                worst = fabs(total - first);
        }
        printf("  energy drift %s: %.2g of the whole in %d steps\n", sb_element_name(element_types[t]), worst / first,
               steps);
        CHECK(first > 0 && worst <= 1e-3 * first);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(v);
    }
}

/* Reactions and loads of the last step. */
static sb_vec3 forces_on(const sb_body *body, int n)
{
    return sb_v3_add(scene_sum(sb_body_reactions(body), n), scene_sum(sb_body_external_forces(body), n));
}

/* A clamped body, shaken by a tool: reactions and loads balance the rate of momentum, step by step for Euler, as the
 * mean of both ends of a step for Newmark (its rule for the velocity). */
static void dynamic_balance(sb_element_type type, int newmark, int neo_hookean)
{
    sb_mesh mesh = scene_box(type, 4, 2, 2, sb_v3(REAL(0.1), REAL(0.05), REAL(0.05)), 0.1);
    sb_body_def def = sb_default_body_def();
    sb_vec3 before, sum, last = sb_v3(0, 0, 0);
    int n = mesh.node_count, tool = n - 1;
    sb_body *body;
    def.mesh = &mesh;
    def.material = neo_hookean ? sb_material_neo_hookean(REAL(5e3), REAL(0.4), REAL(1000))
                               : sb_material_corotated(REAL(5e3), REAL(0.4), REAL(1000));
    def.gravity = sb_v3(REAL(0.3), 0, REAL(-9.81));
    def.integrator = newmark ? SB_NEWMARK : SB_EULER;
    def.mass = SB_MASS_CONSISTENT;
    def.damping_stiffness = REAL(0.01);
    def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-6 : 1e-12);
    def.newton_tolerance = REAL(1e-11);
    def.max_iterations = 2000;
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int s = 0; s < 6; s++) {
        sb_vec3 target = sb_v3(0, 0, REAL(-0.0005) * REAL(s)), rate;
        CHECK_OK(sb_body_prescribe(body, &tool, 1, SB_Z, &target, 1));
        before = sb_body_momentum(body);
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        sum = forces_on(body, n);
        rate = sb_v3_scale(100, sb_v3_sub(sb_body_momentum(body), before));
        if (newmark) {
            sb_vec3 mean = sb_v3_scale(REAL(0.5), sb_v3_add(sum, last));
            last = sum;
            sum = mean;
        }
        if (!newmark || s > 2) /* the tool's start is a jump of velocity, which the mean does not see */
            CHECK_NEAR((double)sb_v3_norm(sb_v3_sub(sum, rate)) / (9.81 * (double)sb_body_mass(body)), 0,
                       scene_tolerance(1e-8, 3000));
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_dynamic_balance(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++)
        for (int k = 0; k < 4; k++)
            dynamic_balance(element_types[t], k % 2, k / 2);
}

/* ---- order in time: a linear bar swinging, against a much finer step ---- */

static sb_vec3 swing(sb_integrator integrator, int steps)
{
    sb_mesh mesh = scene_box(SB_TET10, 4, 1, 1, sb_v3(REAL(0.1), REAL(0.02), REAL(0.02)), 0);
    sb_body_def def = sb_default_body_def();
    sb_vec3 tip;
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_linear(REAL(1e4), REAL(0.3), REAL(1000));
    def.integrator = integrator;
    def.gravity = sb_v3(0, 0, REAL(-0.1));
    def.damping_mass = REAL(0.2);
    def.damping_stiffness = REAL(0.001);
    def.tolerance = REAL(1e-11);
    def.max_iterations = 2000;
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int s = 0; s < steps; s++)
        CHECK_OK(sb_body_step(body, REAL(0.4) / REAL(steps), NULL));
    tip = sb_body_displacements(body)[mesh.node_count - 1];
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return tip;
}

static void test_time_order(void)
{
    static const sb_integrator integrators[2] = {SB_EULER, SB_NEWMARK};
    static const double least[2] = {0.85, 1.9}, most[2] = {1.15, 2.1};
    sb_vec3 reference;
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("orders in time need double");
        return;
    }
    reference = swing(SB_NEWMARK, 1600);
    for (int k = 0; k < 2; k++) {
        double coarse = (double)sb_v3_norm(sb_v3_sub(swing(integrators[k], 100), reference));
        double fine = (double)sb_v3_norm(sb_v3_sub(swing(integrators[k], 200), reference));
        double order = log(coarse / fine) / log(2.0);
        printf("  order in time, %s: %.2f\n", k ? "Newmark" : "Euler", order);
        CHECK(order > least[k] && order < most[k]);
    }
}

/* ---- scale ---- */

/* The beam scene at a scale of lengths; times and moduli follow so that all dimensionless numbers are the same. */
static void scaled_play(double scale, sb_element_type type, int is_static, sb_vec3 *normalised)
{
    sb_mesh mesh = scene_box(type, 5, 2, 2, sb_v3(REAL(0.1 * scale), REAL(0.04 * scale), REAL(0.04 * scale)), 0);
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_neo_hookean(REAL(2e3 * scale), REAL(0.4), REAL(1000));
    if (!is_static)
        def.material = sb_material_corotated(REAL(2e3 * scale), REAL(0.4), REAL(1000));
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.damping_stiffness = REAL(0.01 * sqrt(scale));
    def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-11);
    options.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-11);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    if (is_static)
        CHECK_OK(sb_body_solve_static(body, &options, NULL));
    for (int s = 0; s < 20 && !is_static; s++)
        CHECK_OK(sb_body_step(body, REAL(0.01 * sqrt(scale)), NULL));
    for (int i = 0; i < 20; i++)
        normalised[i] = sb_v3_scale(REAL(1 / (0.1 * scale)), sb_body_displacements(body)[mesh.node_count - 1 - i]);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_scale(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++)
        for (int is_static = 0; is_static < 2; is_static++) {
            sb_vec3 small[20], one[20], large[20];
            scaled_play(1e-3, element_types[t], is_static, small);
            scaled_play(1, element_types[t], is_static, one);
            scaled_play(1e3, element_types[t], is_static, large);
            CHECK(sb_v3_norm(one[0]) > REAL(0.05));
            CHECK_NEAR(scene_distance(small, one, 20), 0, SB_REAL_IS_FLOAT ? 1e-2 : 1e-8);
            CHECK_NEAR(scene_distance(large, one, 20), 0, SB_REAL_IS_FLOAT ? 1e-2 : 1e-8);
        }
}

/* ---- static: closed forms ---- */

/* Uniaxial stretch of a block, free to contract: the neo-Hookean P(lambda) = mu (l - 1/l) + lame ln J / l with the
 * lateral stretch q from P_lateral = 0. */
static void test_uniaxial(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        sb_mesh mesh = scene_box(element_types[t], 2, 2, 2, sb_v3(1, 1, 1), 0.1);
        sb_body_def def = sb_default_body_def();
        sb_static_options options = sb_default_static_options();
        sb_step_info info;
        sb_vec3 target = sb_v3(REAL(0.6), 0, 0);
        double q = 1, l = 1.6, lame, mu, force = 0;
        sb_body *body;
        def.mesh = &mesh;
        def.material = sb_material_neo_hookean(REAL(5e3), REAL(0.3), REAL(1000));
        lame = (double)def.material.lambda;
        mu = (double)def.material.mu;
        for (int k = 0; k < 50; k++) { /* Newton on mu (q^2 - 1) + lame ln(l q^2) = 0 */
            double f = mu * (q * q - 1) + lame * log(l * q * q);
            q -= f / (2 * mu * q + 2 * lame / q);
        }
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_X);
        scene_fix_plane(body, &mesh, 1, 0, SB_Y);
        scene_fix_plane(body, &mesh, 2, 0, SB_Z);
        for (int i = 0; i < mesh.node_count; i++)
            if (mesh.nodes[i].x > REAL(0.9999))
                CHECK_OK(sb_body_prescribe(body, &i, 1, SB_X, &target, 1));
        options.tolerance = REAL(1e-12);
        if (!CHECK_OK(sb_body_solve_static(body, &options, &info)))
            printf("%s\n", info.error.message);
        for (int i = 0; i < mesh.node_count; i++) {
            CHECK_NEAR(sb_body_positions(body)[i].y, q * (double)mesh.nodes[i].y, scene_tolerance(1e-10, 1e3));
            if (mesh.nodes[i].x > REAL(0.9999))
                force += (double)sb_body_reactions(body)[i].x;
        }
        CHECK_NEAR(force, mu * (l - 1 / l) + lame * log(l * q * q) / l, scene_tolerance(1e-8, 1e8));
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* Large bending with every model from one load step: iteration counts are recorded, since drift hides errors. */
static void test_large_bending(void)
{
    static const int most_newton[6] = {15, 15, 27, 15, 16, 16};
    for (int m = 0; m < 6; m++) {
        sb_mesh mesh = scene_box(SB_TET10, 8, 2, 2, sb_v3(REAL(0.1), REAL(0.02), REAL(0.02)), 0);
        sb_material materials[6];
        sb_body_def def = sb_default_body_def();
        sb_static_options options = sb_default_static_options();
        sb_step_info info;
        sb_body *body;
        materials[0] = sb_material_corotated(REAL(5e3), REAL(0.3), REAL(1000));
        materials[1] = sb_material_corotated_invertible(REAL(5e3), REAL(0.3), REAL(1000));
        materials[2] = sb_material_svk(REAL(5e3), REAL(0.3), REAL(1000));
        materials[3] = sb_material_neo_hookean(REAL(5e3), REAL(0.3), REAL(1000));
        materials[4] = sb_material_neo_hookean_isochoric(REAL(961.5), REAL(4.8e-4), REAL(1000));
        materials[5] = sb_material_stable_neo_hookean(REAL(5e3), REAL(0.3), REAL(1000));
        def.mesh = &mesh;
        def.material = materials[m];
        def.gravity = sb_v3(0, 0, REAL(-4));
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        options.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-4 : 1e-9);
        if (!CHECK_OK(sb_body_solve_static(body, &options, &info)))
            printf("%s\n", info.error.message);
        printf("  bending, model %d: %d Newton, %d PCG, tip %.4f m\n", (int)def.material.model, info.newton_iterations,
               info.pcg_iterations, (double)sb_body_displacements(body)[mesh.node_count - 1].z);
        CHECK(info.newton_iterations <= most_newton[m]);
        CHECK_NEAR(info.load_factor, 1, 0);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* ---- undo ---- */

static void test_failed_step_is_undone(void)
{
    /* A neo-Hookean block whose face is driven through the opposite one: no admissible step exists. */
    sb_mesh mesh = scene_box(SB_TET4, 2, 2, 2, sb_v3(1, 1, 1), 0);
    sb_body_def def = sb_default_body_def();
    sb_vec3 *u, *v, *r;
    size_t bytes = (size_t)mesh.node_count * sizeof(sb_vec3);
    sb_vec3 through = sb_v3(-3, 0, 0);
    sb_step_info info;
    sb_body *body;
    u = (sb_vec3 *)malloc(bytes);
    v = (sb_vec3 *)malloc(bytes);
    r = (sb_vec3 *)malloc(bytes);
    def.mesh = &mesh;
    def.material = sb_material_neo_hookean(REAL(5e3), REAL(0.3), REAL(1000));
    def.gravity = sb_v3(0, 0, -1);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    memcpy(u, sb_body_displacements(body), bytes);
    memcpy(v, sb_body_velocities(body), bytes);
    memcpy(r, sb_body_reactions(body), bytes);
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].x > REAL(0.999))
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &through, 1));
    CHECK(sb_body_step(body, REAL(0.01), &info) != SB_OK);
    CHECK(info.error.result != SB_OK && info.error.message[0] != 0);
    CHECK(memcmp(u, sb_body_displacements(body), bytes) == 0);
    CHECK(memcmp(v, sb_body_velocities(body), bytes) == 0);
    CHECK(memcmp(r, sb_body_reactions(body), bytes) == 0);
    CHECK(sb_body_solve_static(body, NULL, &info) != SB_OK);
    CHECK(info.error.message[0] != 0 && info.load_factor < 1);
    CHECK(memcmp(u, sb_body_displacements(body), bytes) == 0);
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].x > REAL(0.999))
            CHECK_OK(sb_body_release_nodes(body, &i, 1, SB_XYZ));
    CHECK_OK(sb_body_step(body, REAL(0.01), &info)); /* and it goes on */
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(u);
    free(v);
    free(r);
}

/* A scene in which the step number `fail_at` (from 1; 0: none) is preceded by one that fails: the hash of the end. */
static unsigned long long play_with_failure(int corotated, int fail_at)
{
    sb_mesh mesh = scene_box(corotated ? SB_TET10 : SB_TET4, 3, 2, 2, sb_v3(REAL(0.15), REAL(0.1), REAL(0.1)), 0.1);
    sb_body_def def = sb_default_body_def();
    unsigned long long hash;
    sb_body *body;
    def.mesh = &mesh;
    def.material = corotated ? sb_material_corotated(REAL(5e3), REAL(0.4), REAL(1000))
                             : sb_material_neo_hookean(REAL(5e3), REAL(0.4), REAL(1000));
    def.gravity = sb_v3(0, REAL(1), REAL(-9.81));
    def.damping_stiffness = REAL(0.01);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int s = 1; s <= 8; s++) {
        if (s == fail_at) { /* an acceleration beyond all numbers */
            CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, SB_REAL_MAX / 2)));
            CHECK(sb_body_step(body, REAL(0.01), NULL) != SB_OK);
            CHECK_OK(sb_body_set_gravity(body, def.gravity));
        }
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    }
    hash = scene_hash(sb_body_displacements(body), (size_t)mesh.node_count * sizeof(sb_vec3)) ^
           scene_hash(sb_body_reactions(body), (size_t)mesh.node_count * sizeof(sb_vec3));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return hash;
}

static void test_undo_leaves_no_trace(void)
{
    check_bad_numbers();
    for (int corotated = 0; corotated < 2; corotated++)
        CHECK(play_with_failure(corotated, 5) == play_with_failure(corotated, 0));
}

/* A linearised step must not leave a shape that its material forbids. */
static void test_linearised_step_refuses_inversion(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 2, 2, 2, sb_v3(1, 1, 1), 0);
    sb_body_def def = sb_default_body_def();
    sb_energy energy;
    sb_step_info info;
    int tool = mesh.node_count / 2;
    sb_vec3 far = sb_v3(3, 0, 0);
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_neo_hookean(REAL(5e3), REAL(0.3), REAL(1000));
    def.max_newton = 1;
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_prescribe(body, &tool, 1, SB_XYZ, &far, 1));
    CHECK_RESULT(sb_body_step(body, REAL(0.01), &info), SB_ERROR_INVERTED);
    CHECK(info.error.element >= 0);
    CHECK_OK(sb_body_release_nodes(body, &tool, 1, SB_XYZ));
    CHECK_OK(sb_body_step(body, REAL(0.01), &info));
    CHECK_OK(sb_body_energy(body, &energy));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_inverted_start(void)
{
    /* ln J has no force inside out: the element is named; the invertible models untangle. */
    for (int m = 0; m < 3; m++) {
        sb_mesh mesh = scene_box(SB_TET4, 2, 2, 2, sb_v3(1, 1, 1), 0);
        sb_body_def def = sb_default_body_def();
        sb_vec3 *u = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof(sb_vec3));
        unsigned long long seed = 11;
        sb_step_info info;
        sb_static_options options = sb_default_static_options();
        sb_body *body;
        def.mesh = &mesh;
        def.material = m == 0   ? sb_material_neo_hookean(REAL(5e3), REAL(0.45), REAL(1000))
                       : m == 1 ? sb_material_corotated(REAL(5e3), REAL(0.45), REAL(1000))
                                : sb_material_stable_neo_hookean(REAL(5e3), REAL(0.45), REAL(1000));
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        for (int i = 0; i < mesh.node_count; i++)
            if (!sb_body_supports(body)[i])
                u[i] = sb_v3(REAL(check_random_in(&seed, -0.5, 0.5)), REAL(check_random_in(&seed, -0.5, 0.5)),
                             REAL(check_random_in(&seed, -0.5, 0.5)));
        CHECK_OK(sb_body_set_displacements(body, u));
        options.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-4 : 1e-8);
        options.max_newton = 200;
        if (m == 0) {
            CHECK_RESULT(sb_body_step(body, REAL(0.01), &info), SB_ERROR_INVERTED);
            CHECK(info.error.element >= 0);
            CHECK_RESULT(sb_body_solve_static(body, NULL, &info), SB_ERROR_INVERTED);
            CHECK(memcmp(u, sb_body_displacements(body), (size_t)mesh.node_count * sizeof(sb_vec3)) == 0);
        } else {
            if (!CHECK_OK(sb_body_solve_static(body, &options, &info)))
                printf("model %d: %s\n", (int)def.material.model, info.error.message);
            printf("  untangling, model %d: %d Newton\n", (int)def.material.model, info.newton_iterations);
            CHECK_NEAR(scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count), 0, 1e-3);
        }
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(u);
    }
}

/* ---- violence ---- */

/* A material that survives everything: one of three models (SB_COROTATED only for single rotation). */
static sb_material tough_material(int model, double young, double poisson)
{
    switch (model) {
    case 0: return sb_material_corotated(REAL(young), REAL(poisson), REAL(1000));
    case 1: return sb_material_corotated_invertible(REAL(young), REAL(poisson), REAL(1000));
    default: return sb_material_stable_neo_hookean(REAL(young), REAL(poisson), REAL(1000));
    }
}

typedef struct beaten_body {
    sb_body *body;
    const sb_mesh *mesh;
    sb_vec3 *u; /* scratch [node_count] */
    unsigned long long seed;
    int models;          /* how many of the tough materials to use */
    double stiffest;     /* largest Poisson's ratio */
    int tool, tool_left; /* node that a tool drags, or -1, and for how many steps */
    sb_vec3 tool_at, tool_speed;
} beaten_body;

static void change_material(beaten_body *b)
{
    double young = pow(10, check_random_in(&b->seed, 3, 6)), poisson = check_random_in(&b->seed, 0, b->stiffest);
    sb_material material = tough_material((int)(check_random(&b->seed) * b->models), young, poisson);
    CHECK_OK(sb_body_set_material(b->body, &material, NULL));
}

/* Throws some nodes about: elements turn inside out. */
static void throw_nodes(beaten_body *b)
{
    int n = b->mesh->node_count;
    memcpy(b->u, sb_body_displacements(b->body), (size_t)n * sizeof(sb_vec3));
    for (int k = 0; k < 4; k++) {
        int i = (int)(check_random(&b->seed) * n);
        if (!sb_body_supports(b->body)[i])
            b->u[i] = sb_v3(REAL(check_random_in(&b->seed, -0.3, 0.3)), REAL(check_random_in(&b->seed, -0.3, 0.3)),
                            REAL(check_random_in(&b->seed, -0.3, 0.3)));
    }
    CHECK_OK(sb_body_set_displacements(b->body, b->u));
}

static void squeeze_flat(beaten_body *b)
{
    for (int i = 0; i < b->mesh->node_count; i++) {
        b->u[i] = sb_body_displacements(b->body)[i];
        if (!sb_body_supports(b->body)[i])
            b->u[i].z = REAL(0.05) - b->mesh->nodes[i].z;
    }
    CHECK_OK(sb_body_set_displacements(b->body, b->u));
}

/* A tool grips a node; it will run at up to 10 m/s along each axis for a quarter of a second and back. */
static void grip(beaten_body *b)
{
    int node = (int)(check_random(&b->seed) * b->mesh->node_count);
    if (sb_body_supports(b->body)[node])
        return;
    b->tool = node;
    b->tool_left = 30;
    b->tool_at = sb_body_displacements(b->body)[node];
    b->tool_speed = sb_v3(REAL(check_random_in(&b->seed, -10, 10)), REAL(check_random_in(&b->seed, -10, 10)),
                          REAL(check_random_in(&b->seed, -10, 10)));
}

static void drag(beaten_body *b)
{
    if (b->tool < 0)
        return;
    b->tool_at = sb_v3_madd(b->tool_at, (b->tool_left > 15 ? 1 : -1) * REAL(1.0 / 60), b->tool_speed);
    if (--b->tool_left > 0) {
        CHECK_OK(sb_body_prescribe(b->body, &b->tool, 1, SB_XYZ, &b->tool_at, 1));
    } else {
        CHECK_OK(sb_body_release_nodes(b->body, &b->tool, 1, SB_XYZ));
        b->tool = -1;
    }
}

static void beat(beaten_body *b)
{
    double dice = check_random(&b->seed);
    if (dice < 0.01)
        change_material(b);
    else if (dice < 0.02)
        throw_nodes(b);
    else if (dice < 0.025)
        squeeze_flat(b);
    else if (dice < 0.05 && b->tool < 0)
        grip(b);
    drag(b);
}

/* Left alone without gravity, it must come back to its shape. Returns the steps that failed. */
static int recover(beaten_body *b)
{
    sb_material material = tough_material(b->models - 1, 1e4, 0.4);
    int failures = 0;
    if (b->tool >= 0)
        CHECK_OK(sb_body_release_nodes(b->body, &b->tool, 1, SB_XYZ));
    CHECK_OK(sb_body_set_material(b->body, &material, NULL));
    CHECK_OK(sb_body_set_gravity(b->body, sb_v3(0, 0, 0)));
    CHECK_OK(sb_body_set_solver(b->body, REAL(1e-4), 500));
    for (int s = 0; s < 600; s++)
        failures += sb_body_step(b->body, REAL(1.0 / 60), NULL) != SB_OK;
    return failures;
}

static void violence(sb_element_type type, int single_rotation, unsigned seed, int steps)
{
    /* quadratic elements have as many nodes in half as many cells each way */
    int linear = sb_element_node_count(type) == sb_element_corner_count(type), across = linear ? 2 : 1;
    sb_mesh mesh = scene_box(type, linear ? 3 : 2, across, across, sb_v3(REAL(0.15), REAL(0.1), REAL(0.1)), 0.1);
    int n = mesh.node_count, failures = 0;
    sb_body_def def = sb_default_body_def();
    beaten_body b;
    double size = 0.2, left;
    memset(&b, 0, sizeof b);
    b.mesh = &mesh;
    b.u = (sb_vec3 *)malloc((size_t)n * sizeof(sb_vec3));
    b.seed = seed;
    b.models = single_rotation ? 1 : 3;
    b.stiffest = sb_element_node_count(type) > sb_element_corner_count(type) ? 0.499 : 0.45;
    b.tool = -1;
    def.mesh = &mesh;
    def.material = tough_material(0, 5e3, 0.4);
    def.single_rotation = single_rotation;
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.damping_stiffness = REAL(0.01);
    def.tolerance = REAL(1e-2);
    def.max_iterations = 60;
    def.newton_tolerance = REAL(1e-3);
    b.body = scene_body(&def);
    scene_fix_plane(b.body, &mesh, 0, 0, SB_XYZ);
    for (int s = 0; s < steps; s++) {
        beat(&b);
        failures += sb_body_step(b.body, REAL(1.0 / 60), NULL) != SB_OK;
        if (!CHECK(scene_all_finite(sb_body_positions(b.body), n) && scene_all_finite(sb_body_velocities(b.body), n)))
            break;
    }
    failures += recover(&b);
    left = scene_distance(sb_body_positions(b.body), mesh.nodes, n) / size;
    printf("  violence %s%s: %d of %d steps undone, %.2g of its size from rest at the end\n", sb_element_name(type),
           single_rotation ? " single rotation" : "", failures, steps + 600, left);
    CHECK_NEAR(left, 0, 1e-3);
    CHECK_INT(failures, 0);
    sb_body_destroy(b.body);
    sb_mesh_free(&mesh);
    free(b.u);
}

static void test_violence(void)
{
    int steps = check_quick() ? 1000 : 10000;
    violence(SB_TET4, 0, 99, steps);
    violence(SB_TET10, 0, 99, steps);
    violence(SB_TET10, 0, 7, steps);
    violence(SB_HEX8, 0, 99, steps);
    violence(SB_TET10, 1, 99, steps);
}

static void test_violence_hexes(void)
{
    violence(SB_HEX20, 0, 99, 1000);
    violence(SB_HEX27, 0, 99, 1000);
}

/* Linearised steps of hyperelastic bodies under a tool that jerks: they may refuse, but never feed energy in. */
static void jerk_linearised(sb_element_type type, sb_integration integration, sb_material material, double reach)
{
    sb_mesh mesh = scene_box(type, 3, 2, 2, sb_v3(REAL(0.1), REAL(0.05), REAL(0.05)), 0);
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    int tip = mesh.node_count - 1, failed = 0;
    double farthest = 0;
    def.mesh = &mesh;
    def.material = material;
    def.integration = integration;
    def.max_newton = 1;
    body = scene_body(&def);
    for (int i = 0; i < mesh.node_count; i++)
        if ((double)mesh.nodes[i].x < 1e-9)
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_XYZ));
    for (int k = 0; k < 400; k++) {
        sb_real way = REAL(k % 2 ? reach : -reach);
        sb_vec3 target = sb_v3(way, 0, way);
        if (k < 60)
            CHECK_OK(sb_body_prescribe(body, &tip, 1, SB_XYZ, &target, 1));
        else if (k == 60)
            CHECK_OK(sb_body_release_nodes(body, &tip, 1, SB_XYZ));
        failed += sb_body_step(body, REAL(1.0 / 60), NULL) != SB_OK;
        farthest = fmax(farthest, (double)scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count));
    }
    printf("  jerks of %g m, %s, model %d: at most %.3f m off, %d of 400 steps refused, %.1e m from rest at the end\n",
           reach, sb_element_name(type), (int)material.model, farthest, failed,
           (double)scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count));
    CHECK(farthest < 10 * reach);
    CHECK(failed < 60); /* none once the tool lets go */
    CHECK((double)scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count) < 0.02);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_linearised_jerks(void)
{
    sb_material stable = sb_material_stable_neo_hookean(REAL(1e4), REAL(0.45), REAL(1000));
    jerk_linearised(SB_HEX8, SB_INTEGRATION_AUTO, stable, 0.015);
    jerk_linearised(SB_HEX8, SB_INTEGRATION_AUTO, stable, 0.03);
    jerk_linearised(SB_TET10, SB_INTEGRATION_AUTO, stable, 0.03);
    jerk_linearised(SB_HEX8, SB_INTEGRATION_BBAR, sb_material_stable_neo_hookean(REAL(1e4), REAL(0.499), REAL(1000)),
                    0.03);
    jerk_linearised(SB_HEX8, SB_INTEGRATION_AUTO, sb_material_svk(REAL(1e4), REAL(0.45), REAL(1000)), 0.015);
}

/* ---- threads ---- */

static void test_threads(void)
{
    static const sb_integrator integrators[2] = {SB_EULER, SB_NEWMARK};
    int steps = check_quick() ? 1 : 10;
    sb_jobs inline_jobs;
    memset(&inline_jobs, 0, sizeof inline_jobs);
    for (int t = 0; t < ELEMENT_TYPES; t++)
        for (int m = 0; m < 2; m++) {
            static const int workers[4] = {1, 2, 3, 7};
            sb_material material = m ? sb_material_neo_hookean(REAL(2e4), REAL(0.4), REAL(1000))
                                     : sb_material_corotated(REAL(2e4), REAL(0.4), REAL(1000));
            unsigned long long expected = scene_play(element_types[t], material, integrators[m], steps, inline_jobs);
            for (int k = 0; k < 4; k++) {
                int count = workers[k];
                CHECK(scene_play(element_types[t], material, integrators[m], steps, scene_jobs(&count)) == expected);
            }
        }
}

/* ---- supports and loads that change between steps ---- */

static void test_moving_supports(void)
{
    /* dragging all nodes of a face at constant speed: they are where they should be, and the reaction of a body
     * that follows in rigid motion is 0 */
    sb_mesh mesh = scene_box(SB_TET10, 3, 1, 1, sb_v3(REAL(0.3), REAL(0.1), REAL(0.1)), 0);
    sb_body_def def = sb_default_body_def();
    sb_step_info info;
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_corotated(REAL(1e4), REAL(0.3), REAL(1000));
    def.damping_stiffness = REAL(0.02);
    def.tolerance = REAL(1e-5);
    body = scene_body(&def);
    for (int s = 1; s <= 300; s++) {
        sb_vec3 target = sb_v3(REAL(0.001 * s), 0, 0);
        for (int i = 0; i < mesh.node_count; i++)
            if (mesh.nodes[i].x == 0)
                CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &target, 1));
        CHECK_OK(sb_body_step(body, REAL(0.01), &info));
        CHECK_INT(info.capped, 0);
    }
    for (int i = 0; i < mesh.node_count; i++) {
        CHECK_NEAR(sb_body_velocities(body)[i].x, 0.1, 1e-3);
        if (mesh.nodes[i].x == 0)
            CHECK_NEAR(sb_body_displacements(body)[i].x, (double)REAL(0.3), 0);
    }
    CHECK_NEAR(scene_sum(sb_body_reactions(body), mesh.node_count).x, 0, 3e-3);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* Damping switched on between steps takes energy out of a swing, and more of it the larger it is. */
static void test_damping_changes(void)
{
    double left[3];
    for (int k = 0; k < 3; k++) {
        sb_mesh mesh = scene_box(SB_TET10, 4, 1, 1, sb_v3(REAL(0.2), REAL(0.04), REAL(0.04)), 0);
        sb_body_def def = sb_default_body_def();
        sb_energy energy;
        sb_body *body;
        def.mesh = &mesh;
        def.material = sb_material_corotated(REAL(2e4), REAL(0.3), REAL(1000));
        def.integrator = SB_NEWMARK;
        def.tolerance = REAL(1e-5);
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, -1)));
        for (int s = 0; s < 20; s++)
            CHECK_OK(sb_body_step(body, REAL(0.005), NULL));
        CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, 0)));
        CHECK_OK(sb_body_set_damping(body, REAL(k), REAL(0.002) * REAL(k)));
        for (int s = 0; s < 100; s++)
            CHECK_OK(sb_body_step(body, REAL(0.005), NULL));
        CHECK_OK(sb_body_energy(body, &energy));
        left[k] = (double)energy.elastic + (double)energy.kinetic;
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
    CHECK(left[1] < 0.7 * left[0] && left[2] < 0.7 * left[1]);
}

static void test_cap(void)
{
    sb_mesh mesh = scene_box(SB_TET10, 6, 2, 2, sb_v3(REAL(0.3), REAL(0.1), REAL(0.1)), 0);
    sb_body_def def = sb_default_body_def();
    sb_step_info info;
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_corotated(REAL(1e5), REAL(0.49), REAL(1000));
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.tolerance = REAL(1e-5);
    def.max_iterations = 3;
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_step(body, REAL(0.01), &info));
    CHECK_INT(info.capped, 1);
    CHECK_INT(info.pcg_iterations, 3);
    CHECK(info.residual > REAL(1e-5));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- many small steps ---- */

typedef struct many_steps {
    sb_integrator integrator;
    int flies; /* 1: a free beam that shakes as it falls; 0: one that motions from its clamp */
    double young, dt;
    int steps;
} many_steps;

typedef struct many_end {
    sb_vec3 last; /* displacement of the last node */
    double lost;  /* what the fall's momentum is off by, as a share of it */
} many_end;

static void shake(sb_body *body, const sb_mesh *mesh)
{
    sb_vec3 *v = (sb_vec3 *)calloc((size_t)mesh->node_count, sizeof *v), mean;
    for (int i = 0; i < mesh->node_count; i++)
        v[i].z = REAL(0.1 * sin(26 * (double)mesh->nodes[i].x));
    CHECK_OK(sb_body_set_velocities(body, v));
    mean = sb_v3_scale(1 / sb_body_mass(body), sb_body_momentum(body));
    for (int i = 0; i < mesh->node_count; i++)
        v[i] = sb_v3_sub(v[i], mean);
    CHECK_OK(sb_body_set_velocities(body, v));
    free(v);
}

static many_end many_play(const many_steps *w, double tolerance)
{
    sb_mesh mesh = scene_box(SB_TET4, 9, 3, 3, sb_v3(REAL(0.12), REAL(0.04), REAL(0.04)), 0);
    sb_body_def def = sb_default_body_def();
    many_end end;
    sb_vec3 fallen;
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_corotated(REAL(w->young), REAL(0.4), 1000);
    def.integrator = w->integrator;
    def.max_newton = 1;
    def.tolerance = REAL(tolerance);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.preconditioner = SB_PRECOND_IC0;
    body = scene_body(&def);
    if (w->flies)
        shake(body, &mesh);
    else
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int s = 0; s < w->steps; s++)
        CHECK_OK(sb_body_step(body, REAL(w->dt), NULL));
    fallen = sb_v3_scale(sb_body_mass(body) * REAL(w->dt * w->steps), def.gravity);
    end.last = sb_body_displacements(body)[mesh.node_count - 1];
    end.lost = (double)(sb_v3_norm(sb_v3_sub(sb_body_momentum(body), fallen)) / sb_v3_norm(fallen));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return end;
}

/* What each step of the default tolerance leaves does not add up over hundreds, though little happens in one. */
static void test_small_steps(void)
{
    static const many_steps motions[4] = {{SB_NEWMARK, 0, 1e4, 2e-4, 600},
                                          {SB_EULER, 0, 3e3, 1e-3, 200},
                                          {SB_NEWMARK, 1, 1e4, 1e-3, 200},
                                          {SB_EULER, 1, 1e4, 1e-3, 200}};
    for (int k = 0; k < 4; k++) {
        many_end end = many_play(motions + k, 1e-3), fine = many_play(motions + k, SB_REAL_IS_FLOAT ? 1e-5 : 1e-8);
        double size = (double)sb_v3_norm(fine.last), off = (double)sb_v3_norm(sb_v3_sub(end.last, fine.last)) / size;
        printf("  small steps %d: off by %.2g of %.2g m, momentum by %.2g\n", k, off, size, end.lost);
        CHECK(off < (SB_REAL_IS_FLOAT ? 0.003 : 1e-4));
        CHECK(!motions[k].flies || end.lost < (SB_REAL_IS_FLOAT ? 1e-4 : 1e-6));
    }
}

/* ---- few unknowns ---- */

/* Steps of a body of few free nodes, where a start by what was before can be exact. It ends where statics have it, with
 * linear elements: lumps of quadratic ones weigh on other nodes than loads of statics do. */
static void check_few(sb_element_type element, int cells, int loose, const sb_material *material,
                      sb_integrator integrator, double tolerance)
{
    sb_mesh mesh = scene_box(element, cells, 1, 1, sb_v3(REAL(0.1), REAL(0.1), REAL(0.1)), 0);
    sb_body_def def = sb_default_body_def();
    int last = mesh.node_count - 1, failed = 0,
        linear = sb_element_corner_count(element) == sb_element_node_count(element);
    sb_vec3 moving, still;
    sb_body *body;
    def.mesh = &mesh;
    def.material = *material;
    def.integrator = integrator;
    def.max_newton = 1;
    def.tolerance = REAL(tolerance);
    def.damping_mass = 5;
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    body = scene_body(&def);
    for (int i = 0; i < mesh.node_count - loose; i++)
        CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_XYZ));
    for (int s = 0; s < 500; s++)
        failed += sb_body_step(body, REAL(1.0 / 60), NULL) != SB_OK;
    CHECK_INT(failed, 0);
    moving = sb_body_displacements(body)[last];
    CHECK_OK(sb_body_solve_static(body, NULL, NULL));
    still = sb_body_displacements(body)[last];
    if (!CHECK(!linear || (double)sb_v3_norm(sb_v3_sub(moving, still)) < 0.02 * (double)sb_v3_norm(still)))
        printf("%d cells, %d free nodes: %g, at rest %g\n", cells, loose, (double)moving.z, (double)still.z);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_few_unknowns(void)
{
    const sb_material materials[3] = {sb_material_linear(REAL(1e4), REAL(0.4), 1060),
                                      sb_material_corotated(REAL(1e4), REAL(0.4), 1060),
                                      sb_material_stable_neo_hookean(REAL(1e4), REAL(0.4), 1060)};
    for (int cells = 1; cells <= 3; cells++)
        for (int loose = 1; loose <= 4; loose++)
            for (int k = 0; k < 3; k++) {
                check_few(SB_TET4, cells, loose, materials + k, SB_EULER, 1e-3);
                check_few(SB_TET4, cells, loose, materials + k, SB_EULER, 1e-6);
                check_few(SB_TET4, cells, loose, materials + k, SB_NEWMARK, 1e-3);
            }
    for (int loose = 1; loose <= 7; loose += 2)
        for (int k = 0; k < 3; k++) {
            check_few(SB_TET10, 1, loose, materials + k, SB_EULER, 1e-3);
            check_few(SB_HEX8, 2, loose, materials + k, SB_GENERALISED_ALPHA, 1e-3);
            check_few(SB_HEX20, 1, loose, materials + k, SB_NEWMARK, 1e-4);
        }
}

CHECK_SUITE(step, {"free fall", test_free_fall}, {"rest for 10,000 steps", test_rest},
            {"Newmark keeps energy", test_newmark_keeps_energy}, {"momentum balance", test_dynamic_balance},
            {"order in time", test_time_order}, {"scale invariance", test_scale},
            {"uniaxial stretch in closed form", test_uniaxial}, {"large bending", test_large_bending},
            {"a failed step is undone", test_failed_step_is_undone},
            {"an undone step leaves no trace", test_undo_leaves_no_trace},
            {"a linearised step refuses inversion", test_linearised_step_refuses_inversion},
            {"inverted start", test_inverted_start}, {"linearised steps under jerks", test_linearised_jerks},
            {"10,000 steps of violence", test_violence},
            {"1,000 steps of violence, quadratic hexes", test_violence_hexes},
            {"same bits for any threads", test_threads}, {"moving supports", test_moving_supports},
            {"damping changes between steps", test_damping_changes}, {"many small steps", test_small_steps},
            {"few unknowns", test_few_unknowns}, {"iteration cap", test_cap});
