/* Prony terms and fibres in a body: relaxation, creep, limits, undo, memory, directions, failures. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

enum { TERMS = 2 };
static const double prony_g[TERMS] = {0.4, 0.25}, prony_tau[TERMS] = {0.05, 0.8};

static double relaxation(double t)
{
    double g = 1;
    for (int i = 0; i < TERMS; i++)
        g -= prony_g[i] * (1 - exp(-t / prony_tau[i]));
    return g;
}

/* What is left of a stress that came about evenly over the last time t: the mean of g. */
static double mean_relaxation(double t)
{
    double g = 1;
    for (int i = 0; i < TERMS; i++)
        g -= prony_g[i] * (1 - (1 - exp(-t / prony_tau[i])) * prony_tau[i] / t);
    return g;
}

static sb_material with_prony(sb_material material)
{
    material.prony_count = TERMS;
    for (int i = 0; i < TERMS; i++) {
        material.prony_g[i] = REAL(prony_g[i]);
        material.prony_tau[i] = REAL(prony_tau[i]);
    }
    return material;
}

enum { MODELS = 6 };

/* A hyperelastic model with its shear modulus times g, at a constant bulk modulus of 8000 Pa. */
static sb_material model_of(int model, double g, double density)
{
    const double bulk = 8000, mu = 2000 * g, young = 9 * bulk * mu / (3 * bulk + mu);
    const double poisson = (3 * bulk - 2 * mu) / (2 * (3 * bulk + mu));
    switch (model) {
    case 0: return sb_material_svk(REAL(young), REAL(poisson), REAL(density));
    case 1: return sb_material_neo_hookean(REAL(young), REAL(poisson), REAL(density));
    case 2: return sb_material_neo_hookean_isochoric(REAL(mu / 2), REAL(2 / bulk), REAL(density));
    case 3: return sb_material_stable_neo_hookean(REAL(young), REAL(poisson), REAL(density));
    case 4: return sb_material_mooney_rivlin(REAL(0.3 * mu), REAL(0.2 * mu), REAL(2 / bulk), REAL(density));
    default:
        return sb_material_reduced_polynomial(REAL(mu / 2), REAL(mu / 5), REAL(mu / 20), REAL(2 / bulk), REAL(density));
    }
}

static sb_body *visco_body(const sb_mesh *mesh, sb_material material, int bbar)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = material;
    def.integration = bbar ? SB_INTEGRATION_BBAR : SB_INTEGRATION_AUTO;
    def.newton_tolerance = REAL(1e-10);
    return scene_body(&def);
}

/* u = (F - I) x as target of all nodes. */
static void prescribe_affine(sb_body *body, const sb_mesh *mesh, sb_mat3 f)
{
    for (int i = 0; i < mesh->node_count; i++) {
        sb_vec3 to = sb_v3_sub(sb_m3_apply(f, mesh->nodes[i]), mesh->nodes[i]);
        CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &to, 1));
    }
}

static sb_result jump(sb_body *body)
{
    sb_static_options options = sb_default_static_options();
    options.instantaneous = 1;
    return sb_body_solve_static(body, &options, NULL);
}

/* Largest entry of the difference of two stresses over that of the second. */
static double stress_error(sb_mat3 a, sb_mat3 b)
{
    double most = 0, size = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            most = fmax(most, fabs((double)a.m[i][j] - (double)b.m[i][j]));
            size = fmax(size, fabs((double)b.m[i][j]));
        }
    return most / size;
}

static sb_mat3 cauchy(sb_material material, sb_mat3 f)
{
    sb_mat3 p = sb_m3_zero();
    CHECK(sb_material_stress(&material, &f, NULL, &p));
    return sb_cauchy_stress(f, p);
}

/* All points of a body have this stress. */
static void check_stress(const sb_body *body, sb_mat3 expected, double tolerance)
{
    for (int e = 0; e < sb_body_element_count(body); e += 5)
        for (int p = 0; p < sb_body_point_count(body); p++) {
            sb_mat3 stress = sb_m3_zero();
            CHECK_OK(sb_body_stress(body, e, p, &stress));
            CHECK_NEAR(stress_error(stress, expected), 0, tolerance);
        }
}

static sb_mat3 shear_and_stretch(void)
{
    sb_mat3 f = sb_m3_identity();
    f.m[0][0] = REAL(1.3);
    f.m[1][1] = REAL(0.85);
    f.m[0][2] = REAL(0.4);
    f.m[1][0] = REAL(-0.1);
    return f;
}

/* ---- relaxation ---- */

static const sb_element_type element_types[3] = {SB_TET4, SB_TET10, SB_HEX8};

/* A sudden strain that is then held: the shear part fades like g(t), exactly, whatever the steps. */
static void step_strain(sb_element_type type, int bbar, int model)
{
    static const double steps[7] = {1e-6, 1e-3, 0.02, 0.05, 0.3, 2, 100};
    sb_mesh mesh = scene_box(type, 2, 2, 2, sb_v3(1, 1, 1), 0.15);
    sb_body *body = visco_body(&mesh, with_prony(model_of(model, 1, 1e-9)), bbar);
    sb_mat3 f = shear_and_stretch();
    double t = 0, tolerance = scene_tolerance(1e-10, 3e3);
    prescribe_affine(body, &mesh, f);
    CHECK_OK(jump(body));
    check_stress(body, cauchy(model_of(model, 1, 1), f), tolerance);
    for (int s = 0; s < 7; s++) {
        t += steps[s];
        CHECK_OK(sb_body_step(body, REAL(steps[s]), NULL));
        check_stress(body, cauchy(model_of(model, relaxation(t), 1), f), tolerance);
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_step_strain(void)
{
    for (int model = 0; model < MODELS; model++) {
        for (int t = 0; t < 3; t++)
            step_strain(element_types[t], 0, model);
        step_strain(SB_HEX8, 1, model);
    }
}

/* Stretches whose Green strain grows evenly: St.Venant's S0 does so too, and any steps are exact. */
static void test_ramp_strain(void)
{
    static const double steps[4] = {0.01, 0.2, 0.04, 0.5};
    const double rate[3] = {0.6, -0.3, 0.1};
    sb_mesh mesh = scene_box(SB_TET10, 2, 2, 2, sb_v3(1, 1, 1), 0.15);
    sb_body *body = visco_body(&mesh, with_prony(model_of(0, 1, 1e-9)), 0);
    double t = 0;
    for (int s = 0; s < 4; s++) {
        sb_mat3 f = sb_m3_identity();
        t += steps[s];
        for (int i = 0; i < 3; i++)
            f.m[i][i] = REAL(sqrt(1 + 2 * t * rate[i]));
        prescribe_affine(body, &mesh, f);
        CHECK_OK(sb_body_step(body, REAL(steps[s]), NULL));
        check_stress(body, cauchy(model_of(0, mean_relaxation(t), 1), f), scene_tolerance(1e-8, 3e3));
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* A strain that comes and goes, with n steps: the stress at the end, at second order. */
static sb_mat3 swing(int n)
{
    sb_mesh mesh = scene_box(SB_TET4, 1, 1, 1, sb_v3(1, 1, 1), 0);
    sb_body *body = visco_body(&mesh, with_prony(model_of(2, 1, 1e-9)), 0);
    sb_mat3 stress = sb_m3_zero();
    for (int s = 1; s <= n; s++) {
        sb_mat3 f = sb_m3_identity();
        f.m[0][1] = REAL(0.6 * sin(3.0 * s / n));
        f.m[2][2] = REAL(1 + 0.2 * sin(2.0 * s / n));
        prescribe_affine(body, &mesh, f);
        CHECK_OK(sb_body_step(body, REAL(1.0 / n), NULL));
    }
    CHECK_OK(sb_body_stress(body, 0, 0, &stress));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return stress;
}

static void test_second_order_in_time(void)
{
    sb_mat3 reference = swing(640);
    double coarse = stress_error(swing(30), reference), fine = stress_error(swing(60), reference);
    printf("  order in time: %.2f (errors %.2g %.2g)\n", log(coarse / fine) / log(2.0), coarse, fine);
    CHECK(fine < 1e-3 && coarse / fine > (SB_REAL_IS_FLOAT ? 3 : 3.8));
}

/* ---- creep: one term, a small shear under a force that stays ---- */

static double creep(int n, double end, double *start)
{
    sb_mesh mesh = scene_box(SB_HEX8, 1, 1, 1, sb_v3(1, 1, 1), 0);
    sb_material material = model_of(2, 1, 1e-9);
    sb_vec3 force = sb_v3(REAL(2000 * 1e-5 / 4), 0, 0);
    double shift = 0;
    sb_body *body;
    material.prony_count = 1;
    material.prony_g[0] = REAL(0.5);
    material.prony_tau[0] = REAL(0.4);
    body = visco_body(&mesh, material, 0);
    for (int i = 0; i < mesh.node_count; i++) {
        int top = mesh.nodes[i].z > REAL(0.5);
        CHECK_OK(sb_body_fix_nodes(body, &i, 1, top ? SB_Y + SB_Z : SB_XYZ));
        if (top)
            CHECK_OK(sb_body_add_forces(body, &i, 1, &force, 1));
    }
    CHECK_OK(jump(body));
    *start = (double)scene_sum(sb_body_displacements(body), 8).x / 4;
    for (int s = 0; s < n; s++)
        CHECK_OK(sb_body_step(body, REAL(end / n), NULL));
    shift = (double)scene_sum(sb_body_displacements(body), 8).x / 4;
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return shift;
}

static void test_creep(void)
{
    /* gamma(t) = gamma_inf + (gamma_0 - gamma_inf) exp(-t/tau_c), tau_c = tau/(1 - g) = 0.8 s */
    double end = 1, expected = 2e-5 - 1e-5 * exp(-end / 0.8), start;
    double coarse = creep(20, end, &start) - expected, fine = creep(40, end, &start) - expected;
    CHECK_NEAR(start / 1e-5, 1, scene_tolerance(1e-8, 1e3));
    printf("  creep to %.4g, error %.2g of it with 20 steps, %.2g with 40\n", expected, coarse / expected,
           fine / expected);
    CHECK_NEAR(fine / expected, 0, scene_tolerance(2e-4, 3e4));
    if (!SB_REAL_IS_FLOAT)
        CHECK_NEAR(coarse / fine, 4, 0.3);
    CHECK_NEAR(creep(2, 400, &start) / 2e-5, 1, scene_tolerance(1e-2, 1e3));
}

/* ---- limits ---- */

/* However it gets there, a body held for long is the elastic one of the long-term moduli; so is the static solve. */
static void test_long_term(void)
{
    sb_mesh mesh = scene_box(SB_TET10, 2, 2, 2, sb_v3(1, 1, 1), 0.15);
    const double rest = relaxation(1e30);
    for (int model = 0; model < MODELS; model++) {
        sb_mat3 f = shear_and_stretch(), expected = cauchy(model_of(model, rest, 1), f);
        sb_body *elastic = visco_body(&mesh, model_of(model, rest, 1), 0);
        sb_energy energy, elastic_energy;
        for (int way = 0; way < 4; way++) {
            static const int pieces[4] = {0, 1, 7, 60};
            sb_body *body = visco_body(&mesh, with_prony(model_of(model, 1, 1e-9)), 0);
            for (int s = 1; s <= pieces[way]; s++) {
                double share = (double)s / pieces[way];
                prescribe_affine(
                    body, &mesh,
                    sb_m3_add(sb_m3_scale(REAL(share), f), sb_m3_scale(REAL(1 - share), sb_m3_identity())));
                CHECK_OK(sb_body_step(body, REAL(1.0 / pieces[way]), NULL));
            }
            prescribe_affine(body, &mesh, f);
            if (way == 0)
                CHECK_OK(sb_body_solve_static(body, NULL, NULL));
            else
                CHECK_OK(sb_body_step(body, 60, NULL));
            if (way > 0)
                CHECK_OK(sb_body_step(body, 60, NULL));
            check_stress(body, expected, scene_tolerance(1e-10, 3e3));
            CHECK_OK(sb_body_energy(body, &energy));
            CHECK_OK(sb_body_set_displacements(elastic, sb_body_displacements(body)));
            CHECK_OK(sb_body_energy(elastic, &elastic_energy));
            CHECK_NEAR(energy.elastic / elastic_energy.elastic, 1, scene_tolerance(1e-11, 1e3));
            sb_body_destroy(body);
        }
        sb_body_destroy(elastic);
    }
    sb_mesh_free(&mesh);
}

/* Without supports on all nodes: the long-term solve is that of the elastic body, and a linearised step works. */
static void test_static_and_linearised(void)
{
    sb_mesh mesh = scene_box(SB_TET10, 6, 2, 2, sb_v3(REAL(0.1), REAL(0.03), REAL(0.03)), 0.1);
    sb_static_options options = sb_default_static_options();
    sb_body *bodies[2], *stepped[2];
    double tip[2];
    options.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-4 : 1e-10);
    for (int k = 0; k < 2; k++) {
        bodies[k] = visco_body(&mesh, k ? with_prony(model_of(1, 1, 1000)) : model_of(1, relaxation(1e30), 1000), 0);
        CHECK_OK(sb_body_set_gravity(bodies[k], sb_v3(0, 0, -2)));
        scene_fix_plane(bodies[k], &mesh, 0, 0, SB_XYZ);
        CHECK_OK(sb_body_solve_static(bodies[k], &options, NULL));
    }
    CHECK(sb_v3_norm(sb_body_displacements(bodies[0])[mesh.node_count - 1]) > REAL(0.01));
    CHECK_NEAR(scene_distance(sb_body_displacements(bodies[0]), sb_body_displacements(bodies[1]), mesh.node_count), 0,
               SB_REAL_IS_FLOAT ? 1e-4 : 1e-9);
    for (int k = 0; k < 2; k++) { /* a step in the resting state stays there, linearised or not */
        sb_body_def def = sb_default_body_def();
        def.mesh = &mesh;
        def.material = with_prony(model_of(1, 1, 1000));
        def.max_newton = k ? 1 : 20;
        def.gravity = sb_v3(0, 0, REAL(-0.05));
        def.damping_stiffness = REAL(0.02);
        def.tolerance = REAL(1e-6);
        stepped[k] = scene_body(&def);
        scene_fix_plane(stepped[k], &mesh, 0, 0, SB_XYZ);
        for (int s = 0; s < 60; s++)
            CHECK_OK(sb_body_step(stepped[k], REAL(0.02), NULL));
        tip[k] = (double)sb_body_displacements(stepped[k])[mesh.node_count - 1].z;
        sb_body_destroy(stepped[k]);
        sb_body_destroy(bodies[k]);
    }
    printf("  sagging: tip %.6g m, linearised %.6g m\n", tip[0], tip[1]);
    CHECK(tip[0] < -1e-5 && fabs(tip[1] / tip[0] - 1) < 0.02);
    sb_mesh_free(&mesh);
}

/* ---- motion: what swings comes to rest by itself ---- */

static void test_swing_dies(void)
{
    for (int newmark = 0; newmark < 2; newmark++) {
        sb_mesh mesh = scene_box(SB_TET10, 4, 1, 1, sb_v3(REAL(0.1), REAL(0.03), REAL(0.03)), 0);
        sb_vec3 *v = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof(sb_vec3));
        double left[2];
        for (int viscous = 0; viscous < 2; viscous++) {
            sb_material material = model_of(3, 1, 1000);
            sb_body_def def = sb_default_body_def();
            sb_energy energy;
            sb_body *body;
            double first = 0;
            def.mesh = &mesh;
            def.material = viscous ? with_prony(material) : material;
            def.integrator = newmark ? SB_NEWMARK : SB_EULER;
            body = scene_body(&def);
            scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
            for (int i = 0; i < mesh.node_count; i++)
                v[i].z = 20 * mesh.nodes[i].x * mesh.nodes[i].x;
            CHECK_OK(sb_body_set_velocities(body, v));
            CHECK_OK(sb_body_energy(body, &energy));
            first = (double)energy.kinetic;
            for (int s = 0; s < 150; s++)
                CHECK_OK(sb_body_step(body, REAL(0.004), NULL));
            CHECK_OK(sb_body_energy(body, &energy));
            left[viscous] = ((double)energy.kinetic + (double)energy.elastic) / first;
            sb_body_destroy(body);
        }
        printf("  %s: %.2g of the energy left, %.2g with Prony terms\n", newmark ? "Newmark" : "Euler", left[0],
               left[1]);
        CHECK(left[1] < 0.6 * left[0] && left[1] >= 0);
        if (newmark)
            CHECK(left[0] > 0.9);
        sb_mesh_free(&mesh);
        free(v);
    }
}

/* ---- undo, threads, failures ---- */

static unsigned long long state_hash(const sb_body *body)
{
    size_t n = (size_t)sb_body_node_count(body);
    unsigned long long hash = scene_hash(sb_body_displacements(body), n * sizeof(sb_vec3)) ^
                              scene_hash(sb_body_velocities(body), n * sizeof(sb_vec3)) * 3 ^
                              scene_hash(sb_body_reactions(body), n * sizeof(sb_vec3)) * 5;
    for (int e = 0; e < sb_body_element_count(body); e++)
        for (int p = 0; p < sb_body_point_count(body); p++) {
            sb_mat3 stress = sb_m3_zero();
            CHECK_OK(sb_body_stress(body, e, p, &stress));
            hash = hash * 31 + scene_hash(&stress, sizeof stress);
        }
    return hash;
}

/* A scene; before step fail_at (from 1; 0: none) a step and a static solve fail. */
static unsigned long long play(int bbar, sb_integrator integrator, int fail_at, sb_jobs jobs)
{
    sb_mesh mesh = scene_box(SB_HEX8, 6, 4, 4, sb_v3(REAL(0.15), REAL(0.1), REAL(0.1)), 0.1);
    sb_body_def def = sb_default_body_def();
    unsigned long long hash, before;
    sb_body *body;
    def.mesh = &mesh;
    def.material = with_prony(model_of(1, 1, 1000));
    def.integration = bbar ? SB_INTEGRATION_BBAR : SB_INTEGRATION_AUTO;
    def.integrator = integrator;
    def.gravity = sb_v3(0, REAL(1), REAL(-9.81));
    def.damping_stiffness = REAL(0.01);
    def.jobs = jobs;
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int s = 1; s <= 6; s++) {
        if (s == fail_at) {
            before = state_hash(body);
            CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, SB_REAL_MAX / 2)));
            CHECK(sb_body_step(body, REAL(0.02), NULL) != SB_OK);
            CHECK(state_hash(body) == before);
            CHECK(sb_body_solve_static(body, NULL, NULL) != SB_OK);
            CHECK(state_hash(body) == before);
            CHECK_OK(sb_body_set_gravity(body, def.gravity));
        }
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    }
    hash = state_hash(body);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return hash;
}

static void test_undo(void)
{
    check_bad_numbers();
    sb_jobs jobs;
    memset(&jobs, 0, sizeof jobs);
    for (int bbar = 0; bbar < 2; bbar++) {
        CHECK(play(bbar, SB_EULER, 4, jobs) == play(bbar, SB_EULER, 0, jobs));
        CHECK(play(bbar, SB_NEWMARK, 4, jobs) == play(bbar, SB_NEWMARK, 0, jobs));
    }
}

static void test_threads(void)
{
    sb_jobs jobs;
    unsigned long long expected;
    int workers = 7;
    memset(&jobs, 0, sizeof jobs);
    expected = play(1, SB_EULER, 0, jobs);
    CHECK(play(1, SB_EULER, 0, scene_jobs(&workers)) == expected);
}

/* Reset and a material set anew leave nothing of what was. */
static void test_forgetting(void)
{
    sb_mesh mesh = scene_box(SB_TET10, 2, 1, 1, sb_v3(2, 1, 1), 0);
    sb_material material = with_prony(model_of(1, 1, 1e-9)), three;
    sb_mat3 f = shear_and_stretch(), stress = sb_m3_zero();
    sb_body *body;
    mesh.regions = (int *)malloc((size_t)mesh.element_count * sizeof(int));
    for (int e = 0; e < mesh.element_count; e++)
        mesh.regions[e] = e % 2;
    body = visco_body(&mesh, material, 0);
    prescribe_affine(body, &mesh, f);
    CHECK_OK(jump(body));
    three = material;
    three.prony_count = 3;
    three.prony_g[2] = REAL(0.1);
    three.prony_tau[2] = REAL(3);
    CHECK_OK(sb_body_set_region_material(body, 1, &three, NULL)); /* more terms: room is made, the rest is kept */
    for (int e = 0; e < mesh.element_count; e++) {
        double g = e % 2 ? relaxation(1e30) - 0.1 : 1;
        CHECK_OK(sb_body_stress(body, e, 0, &stress));
        CHECK_NEAR(stress_error(stress, cauchy(model_of(1, g, 1), f)), 0, scene_tolerance(1e-10, 3e3));
    }
    CHECK_OK(sb_body_step(body, REAL(0.05), NULL));
    for (int e = 0; e < mesh.element_count; e++) {
        double g = e % 2 ? relaxation(1e30) - 0.1 : relaxation(0.05);
        CHECK_OK(sb_body_stress(body, e, 0, &stress));
        CHECK_NEAR(stress_error(stress, cauchy(model_of(1, g, 1), f)), 0, scene_tolerance(1e-10, 3e3));
    }
    sb_body_reset(body);
    CHECK_OK(sb_body_stress(body, 0, 0, &stress));
    CHECK_NEAR(sb_von_mises(stress) + sb_abs(sb_m3_trace(stress)), 0, 0);
    prescribe_affine(body, &mesh, sb_m3_identity());
    CHECK_OK(sb_body_step(body, REAL(0.05), NULL));
    CHECK_OK(sb_body_stress(body, 0, 0, &stress));
    CHECK_NEAR(sb_von_mises(stress), 0, scene_tolerance(1e-12, 1e4));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* Thousands of wild steps with inversions: finite, and back to the old shape when left alone. */
static void test_violence(void)
{
    sb_mesh mesh = scene_box(SB_TET10, 2, 2, 2, sb_v3(REAL(0.1), REAL(0.1), REAL(0.1)), 0.1);
    int n = mesh.node_count, failures = 0;
    sb_vec3 *u = (sb_vec3 *)malloc((size_t)n * sizeof(sb_vec3));
    unsigned long long seed = 31;
    sb_body_def def = sb_default_body_def();
    double left;
    sb_body *body;
    def.mesh = &mesh;
    def.material = with_prony(model_of(3, 1, 1000));
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.damping_stiffness = REAL(0.01);
    def.newton_tolerance = REAL(1e-3);
    def.tolerance = REAL(1e-2);
    def.max_iterations = 60;
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int s = 0, end = check_rounds(400); s < end; s++) {
        memcpy(u, sb_body_displacements(body), (size_t)n * sizeof(sb_vec3));
        for (int i = 0; i < n && s % 50 == 0; i++) {
            if (sb_body_supports(body)[i])
                continue;
            if (s % 100 == 0 && check_random(&seed) < 0.1)
                u[i] = sb_v3(REAL(check_random_in(&seed, -0.2, 0.2)), REAL(check_random_in(&seed, -0.2, 0.2)),
                             REAL(check_random_in(&seed, -0.2, 0.2)));
            else if (s % 100 == 50) /* flat, or nearly so */
                u[i].z = REAL(0.05) - mesh.nodes[i].z * REAL(s % 200 == 50 ? 1 : 0.999);
        }
        if (s % 50 == 0)
            CHECK_OK(sb_body_set_displacements(body, u));
        failures += sb_body_step(body, REAL(1.0 / 60), NULL) != SB_OK;
        if (!CHECK(scene_all_finite(sb_body_positions(body), n)))
            break;
    }
    CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, 0)));
    CHECK_OK(sb_body_set_solver(body, REAL(1e-4), 500));
    for (int s = 0; s < 1000; s++) /* the slower term creeps back with 0.8 s / 0.35 */
        failures += sb_body_step(body, REAL(1.0 / 60), NULL) != SB_OK;
    left = scene_distance(sb_body_positions(body), mesh.nodes, n);
    printf("  violence: %d steps undone, %.2g m from rest at the end\n", failures, left);
    CHECK_NEAR(left, 0, 2e-4);
    CHECK_INT(failures, 0);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(u);
}

/* ---- fibres ---- */

static sb_material with_fibres(sb_material material, double k1, double k2)
{
    material.fibre_stiffness = REAL(k1);
    material.fibre_exponent = REAL(k2);
    return material;
}

/* One direction for all elements. */
static sb_vec3 *directions(const sb_mesh *mesh, sb_vec3 a)
{
    sb_vec3 *fibres = (sb_vec3 *)malloc((size_t)mesh->element_count * sizeof(sb_vec3));
    for (int e = 0; e < mesh->element_count; e++)
        fibres[e] = a;
    return fibres;
}

/* P of fibres along the unit a at F: 2 k1 e exp(k2 e^2) (F a) a^T, e = |F a|^2 - 1. */
static sb_mat3 fibre_stress(double k1, double k2, sb_mat3 f, sb_vec3 a)
{
    sb_vec3 fa = sb_m3_apply(f, a);
    double e = (double)sb_v3_dot(fa, fa) - 1;
    return sb_m3_outer(sb_v3_scale(REAL(e > 0 ? 2 * k1 * e * exp(k2 * e * e) : 0), fa), a);
}

static void test_fibres_stress(void)
{
    const double k1 = 3000, k2 = 1.5;
    const sb_vec3 unit = sb_v3(REAL(0.6), 0, REAL(0.8)), none = sb_v3(0, 0, 0), across = sb_v3(0, 1, 0);
    sb_mat3 f = shear_and_stretch();
    for (int k = 0; k < 4; k++) { /* tet4, tet10, hex8, B-bar */
        sb_mesh mesh = scene_box(element_types[k < 3 ? k : 2], 2, 2, 2, sb_v3(1, 1, 1), 0.1);
        sb_vec3 *fibres = directions(&mesh, sb_v3_scale(7, unit));
        sb_material matrix = model_of(3, 1, 1000), material = with_fibres(matrix, k1, k2);
        sb_body_def def = sb_default_body_def();
        sb_mat3 p = sb_m3_zero(), along, stress;
        sb_body *body;
        fibres[1] = none;
        fibres[2] = across; /* compressed: slack */
        def.mesh = &mesh;
        def.material = material;
        def.fibres = fibres;
        def.integration = k == 3 ? SB_INTEGRATION_BBAR : SB_INTEGRATION_AUTO;
        body = scene_body(&def);
        prescribe_affine(body, &mesh, f);
        CHECK_OK(sb_body_solve_static(body, NULL, NULL));
        CHECK(sb_material_stress(&matrix, &f, NULL, &p));
        along = sb_m3_add(p, fibre_stress(k1, k2, f, unit));
        for (int e = 0; e < 4; e++)
            for (int q = 0; q < sb_body_point_count(body); q++) {
                CHECK_OK(sb_body_stress(body, e, q, &stress));
                CHECK_NEAR(stress_error(stress, sb_cauchy_stress(f, e == 1 || e == 2 ? p : along)), 0,
                           scene_tolerance(1e-11, 3e3));
            }
        for (int e = 0; e < mesh.element_count; e++)
            fibres[e] = across;
        CHECK_OK(sb_body_set_fibres(body, fibres, NULL));
        CHECK_OK(sb_body_stress(body, 3, 0, &stress));
        CHECK_NEAR(stress_error(stress, sb_cauchy_stress(f, p)), 0, scene_tolerance(1e-11, 3e3));
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(fibres);
    }
}

/* Forces are the energy's derivative, and a block stretched along its fibres finds the closed form. */
static void test_fibres_solve(void)
{
    const double k1 = 4000, k2 = 2, h = SB_REAL_IS_FLOAT ? 2e-3 : 1e-5;
    sb_mesh mesh = scene_box(SB_TET10, 2, 2, 2, sb_v3(1, 1, 1), 0.1);
    sb_vec3 *fibres = directions(&mesh, sb_v3(1, 0, 0)), *u, *d, *moved, target = sb_v3(REAL(0.3), 0, 0);
    size_t bytes = (size_t)mesh.node_count * sizeof(sb_vec3);
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    unsigned long long seed = 3;
    sb_energy energy;
    sb_step_info info;
    sb_body *body;
    double work = 0, sides[2] = {0, 0}, force = 0, lateral;
    def.mesh = &mesh;
    def.material = with_fibres(model_of(1, 1, 1000), k1, k2);
    def.fibres = fibres;
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_X);
    scene_fix_plane(body, &mesh, 1, 0, SB_Y);
    scene_fix_plane(body, &mesh, 2, 0, SB_Z);
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].x > REAL(0.999))
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_X, &target, 1));
    options.tolerance = REAL(1e-12);
    CHECK_OK(sb_body_solve_static(body, &options, &info));
    CHECK(info.newton_iterations <= 12);
    lateral =
        1 + (double)sb_body_displacements(body)[mesh.node_count - 1].y / (double)mesh.nodes[mesh.node_count - 1].y;
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].x > REAL(0.999))
            force += (double)sb_body_reactions(body)[i].x;
    {
        sb_mat3 f = sb_m3_identity(), p = sb_m3_zero();
        sb_material matrix = model_of(1, 1, 1000);
        f.m[0][0] = REAL(1.3);
        f.m[1][1] = f.m[2][2] = REAL(lateral);
        CHECK(sb_material_stress(&matrix, &f, NULL, &p));
        p = sb_m3_add(p, fibre_stress(k1, k2, f, sb_v3(1, 0, 0)));
        CHECK_NEAR(p.m[1][1] / p.m[0][0], 0, scene_tolerance(1e-9, 1e3));
        CHECK_NEAR(force / (double)p.m[0][0], 1, scene_tolerance(1e-9, 1e3));
    }
    u = (sb_vec3 *)malloc(bytes);
    d = (sb_vec3 *)malloc(bytes);
    moved = (sb_vec3 *)malloc(bytes);
    for (int i = 0; i < mesh.node_count; i++) {
        d[i] = sb_v3(REAL(check_random_in(&seed, -1, 1)), REAL(check_random_in(&seed, -1, 1)), 0);
        u[i] = sb_v3_madd(sb_body_displacements(body)[i], REAL(0.02), d[i]);
        CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u[i], 1));
    }
    CHECK_OK(sb_body_solve_static(body, NULL, NULL));
    for (int i = 0; i < mesh.node_count; i++)
        work += (double)sb_v3_dot(sb_body_reactions(body)[i], d[i]);
    for (int side = 0; side < 2; side++) {
        for (int i = 0; i < mesh.node_count; i++)
            moved[i] = sb_v3_madd(u[i], REAL(side ? h : -h), d[i]);
        CHECK_OK(sb_body_set_displacements(body, moved));
        CHECK_OK(sb_body_energy(body, &energy));
        sides[side] = (double)energy.elastic;
    }
    CHECK_NEAR((sides[1] - sides[0]) / (2 * h) / work, 1, SB_REAL_IS_FLOAT ? 1e-2 : 1e-6);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(fibres);
    free(u);
    free(d);
    free(moved);
}

/* Fibres relax with the rest. */
static void test_fibres_relax(void)
{
    const double k1 = 4000;
    sb_mesh mesh = scene_box(SB_HEX8, 2, 2, 2, sb_v3(1, 1, 1), 0.1);
    sb_vec3 *fibres = directions(&mesh, sb_v3(0, 0, 2));
    sb_body_def def = sb_default_body_def();
    sb_mat3 f = shear_and_stretch();
    sb_body *body;
    f.m[2][2] = REAL(1.2);
    for (int bbar = 0; bbar < 2; bbar++) {
        def.mesh = &mesh;
        def.material = with_prony(with_fibres(model_of(2, 1, 1e-9), k1, 0));
        def.fibres = fibres;
        def.integration = bbar ? SB_INTEGRATION_BBAR : SB_INTEGRATION_AUTO;
        body = scene_body(&def);
        prescribe_affine(body, &mesh, f);
        CHECK_OK(jump(body));
        for (int s = 0; s < 3; s++) {
            double g = relaxation(0.1 * s);
            sb_mat3 expected = sb_cauchy_stress(f, fibre_stress(g * k1, 0, f, sb_v3(0, 0, 1)));
            check_stress(body, sb_m3_add(expected, cauchy(model_of(2, g, 1), f)), scene_tolerance(1e-10, 3e3));
            CHECK_OK(sb_body_step(body, REAL(0.1), NULL));
        }
        sb_body_destroy(body);
    }
    sb_mesh_free(&mesh);
    free(fibres);
}

/* ---- failures ---- */

static void test_fibres_failures(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 2, 1, 1, sb_v3(2, 1, 1), 0);
    sb_vec3 *fibres = directions(&mesh, sb_v3(1, 0, 0));
    sb_material plain = model_of(1, 1, 1000), strong = with_fibres(plain, 100, 1);
    sb_region_material region;
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_error error;
    mesh.regions = (int *)calloc((size_t)mesh.element_count, sizeof(int));
    mesh.regions[3] = mesh.regions[5] = 9;
    region.region = 9;
    region.material = strong;
    def.mesh = &mesh;
    def.material = plain;
    def.region_materials = &region;
    def.region_material_count = 1;
    CHECK_RESULT(sb_body_create(&def, &body, &error), SB_ERROR_MATERIAL);
    CHECK_INT(error.element, 3);
    CHECK(body == NULL && strstr(error.message, "fibres") != NULL);
    fibres[4] = sb_v3(0, REAL(NAN), 0);
    def.fibres = fibres;
    CHECK_RESULT(sb_body_create(&def, &body, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.element, 4);
    fibres[4] = sb_v3(0, SB_REAL_MAX, SB_REAL_MAX); /* finite, though its square is not */
    CHECK_OK(sb_body_create(&def, &body, &error));
    CHECK_RESULT(sb_body_set_fibres(body, NULL, &error), SB_ERROR_MATERIAL);
    CHECK_INT(error.element, 3);
    CHECK_OK(sb_body_set_material(body, &plain, &error));
    CHECK_OK(sb_body_set_fibres(body, NULL, &error));
    CHECK_RESULT(sb_body_set_region_material(body, 9, &strong, &error), SB_ERROR_MATERIAL);
    CHECK_INT(error.element, 3);
    CHECK_RESULT(sb_body_set_material(body, &strong, &error), SB_ERROR_MATERIAL);
    CHECK_INT(error.element, 0);
    CHECK_RESULT(sb_body_set_fibres(NULL, fibres, &error), SB_ERROR_ARGUMENT);
    fibres[4] = sb_v3(0, REAL(NAN), 0);
    CHECK_RESULT(sb_body_set_fibres(body, fibres, &error), SB_ERROR_NOT_FINITE);
    fibres[4] = sb_v3(0, 1, 0);
    CHECK_OK(sb_body_set_fibres(body, fibres, &error));
    CHECK_OK(sb_body_set_material(body, &strong, &error));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(fibres);
}

/* Creation with each allocation failing in turn, then a material with more terms and new fibres likewise. */
static void test_every_allocation_fails(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 2, 1, 1, sb_v3(2, 1, 1), 0);
    sb_vec3 *fibres = directions(&mesh, sb_v3(1, 0, 0));
    sb_body_def def = sb_default_body_def();
    sb_material more = with_prony(model_of(1, 1, 1000));
    scene_memory memory = {0, 0, 0, 0};
    sb_body *body = NULL;
    sb_error error;
    more.prony_count = 3;
    more.prony_g[2] = REAL(0.1);
    more.prony_tau[2] = REAL(3);
    def.mesh = &mesh;
    def.material = with_prony(model_of(1, 1, 1000));
    def.fibres = fibres;
    def.allocator = scene_allocator(&memory);
    for (int n = 1;; n++) {
        sb_result result;
        memory.calls = 0;
        memory.fail_at = n;
        result = sb_body_create(&def, &body, &error);
        if (result == SB_OK)
            break;
        CHECK_RESULT(result, SB_ERROR_MEMORY);
        CHECK_INT(memory.live, 0);
        CHECK(body == NULL);
    }
    memory.calls = 0;
    memory.fail_at = 1;
    CHECK_RESULT(sb_body_set_material(body, &more, &error), SB_ERROR_MEMORY);
    memory.fail_at = 0;
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    CHECK_OK(sb_body_set_material(body, &more, &error));
    memory.calls = 0;
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    CHECK_INT(memory.calls, 0); /* a step allocates nothing */
    CHECK_OK(sb_body_set_fibres(body, NULL, &error));
    memory.calls = 0;
    memory.fail_at = 1;
    CHECK_RESULT(sb_body_set_fibres(body, fibres, &error), SB_ERROR_MEMORY);
    sb_body_destroy(body);
    CHECK_INT(memory.live, 0);
    def.fibres = NULL; /* an elastic body becomes viscous later: two pieces of memory */
    def.material = model_of(1, 1, 1000);
    memory.fail_at = 0;
    CHECK_OK(sb_body_create(&def, &body, &error));
    for (int n = 1; n <= 2; n++) {
        memory.calls = 0;
        memory.fail_at = n;
        CHECK_RESULT(sb_body_set_material(body, &more, &error), SB_ERROR_MEMORY);
    }
    memory.fail_at = 0;
    CHECK_OK(sb_body_set_material(body, &more, &error));
    sb_body_destroy(body);
    CHECK_INT(memory.live, 0);
    sb_mesh_free(&mesh);
    free(fibres);
}

CHECK_SUITE(viscoelastic, {"step strain", test_step_strain}, {"ramp strain", test_ramp_strain},
            {"second order in time", test_second_order_in_time}, {"creep", test_creep}, {"long term", test_long_term},
            {"static and linearised", test_static_and_linearised}, {"a swing dies", test_swing_dies},
            {"undo", test_undo}, {"threads", test_threads}, {"forgetting", test_forgetting},
            {"violence", test_violence}, {"fibres: stress", test_fibres_stress}, {"fibres: solve", test_fibres_solve},
            {"fibres: relax", test_fibres_relax}, {"fibres: failures", test_fibres_failures},
            {"every allocation fails", test_every_allocation_fails});
