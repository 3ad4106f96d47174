/* Fibres: dispersion, two families and contraction: derivatives, closed forms, published figures; bodies with them in
 * steps, states and recordings. (One family without either: suites material and viscoelastic.) */
#include "scene.h"

static double largest_of(const sb_real *a, int count)
{
    double largest = 0;
    for (int i = 0; i < count; i++)
        if (!(fabs((double)a[i]) <= largest))
            largest = fabs((double)a[i]);
    return largest;
}

static sb_vec3 random_direction(unsigned long long *seed)
{
    for (;;) {
        sb_vec3 a = sb_v3(REAL(check_random_in(seed, -1, 1)), REAL(check_random_in(seed, -1, 1)),
                          REAL(check_random_in(seed, -1, 1)));
        if (sb_v3_norm(a) > REAL(0.3))
            return a;
    }
}

static sb_mat3 random_deformation(unsigned long long *seed, double spread)
{
    sb_mat3 f = sb_m3_identity();
    for (int i = 0; i < 9; i++)
        f.m[i / 3][i % 3] += REAL(check_random_in(seed, -spread, spread));
    return f;
}

static sb_material random_fibres(unsigned long long *seed, int contracts)
{
    sb_material m = sb_material_neo_hookean(5000, REAL(0.4), 1000);
    m = sb_material_with_fibres(m, REAL(check_random_in(seed, 0, 3000)), REAL(check_random_in(seed, 0, 3)));
    m = sb_material_with_dispersion(m, REAL(check_random_in(seed, 0, 1.0 / 3)));
    if (contracts)
        m = sb_material_with_contraction(m, REAL(check_random_in(seed, 0, 4000)), REAL(check_random_in(seed, 0.8, 1.3)),
                                         REAL(contracts == 1 ? 0 : check_random_in(seed, 0.2, 1)));
    return m;
}

/* ---- one point ---- */

static void test_derivatives(void)
{
    const double step = cbrt((double)SB_EPSILON), bound = fmax(1e-6, 1e3 * pow((double)SB_EPSILON, 2.0 / 3));
    unsigned long long seed = 41;
    int away = 0;
    for (int sample = 0; sample < 300; sample++) {
        sb_material m = random_fibres(&seed, sample % 3);
        sb_mat3 f = random_deformation(&seed, 0.3), p = sb_m3_zero(), slope;
        sb_vec3 a = random_direction(&seed), unit = sb_v3_scale(1 / sb_v3_norm(a), a);
        sb_real A[81] = {0}, expected[81], energy = 0;
        double l = (double)sb_v3_norm(sb_m3_apply(f, unit)), kappa = (double)m.fibre_dispersion;
        double e = kappa * (double)sb_m3_ddot(f, f) + (1 - 3 * kappa) * l * l - 1;
        double reach = fabs(l - (double)m.fibre_optimum) - (double)m.fibre_width, size;
        CHECK(sb_fibre_energy(&m, &f, a, &energy) && sb_fibre_stress(&m, &f, a, &p) && sb_fibre_tangent(&m, &f, a, A));
        for (int r = 0; r < 9; r++)
            for (int c = 0; c < r; c++)
                CHECK(A[9 * r + c] == A[9 * c + r]);
        if (fabs(e) < 4 * step || fabs(reach) < 4 * step) /* across a kink */
            continue;
        for (int i = 0; i < 9; i++) {
            sb_mat3 low = f, high = f, below = sb_m3_zero(), above = sb_m3_zero();
            sb_real least = 0, most = 0, moved;
            high.m[i / 3][i % 3] += REAL(step);
            low.m[i / 3][i % 3] -= REAL(step);
            moved = high.m[i / 3][i % 3] - low.m[i / 3][i % 3];
            CHECK(sb_fibre_energy(&m, &low, a, &least) && sb_fibre_energy(&m, &high, a, &most));
            CHECK(sb_fibre_stress(&m, &low, a, &below) && sb_fibre_stress(&m, &high, a, &above));
            slope.m[i / 3][i % 3] = (most - least) / moved;
            for (int q = 0; q < 9; q++)
                expected[9 * q + i] = (above.m[q / 3][q % 3] - below.m[q / 3][q % 3]) / moved;
        }
        size = largest_of(A, 81) + (double)m.fibre_stiffness + (double)m.fibre_tension;
        for (int i = 0; i < 9; i++)
            CHECK_NEAR(slope.m[i / 3][i % 3], p.m[i / 3][i % 3], bound * size);
        for (int i = 0; i < 81; i++)
            CHECK_NEAR(expected[i], A[i], 4 * bound * size);
        away++;
    }
    CHECK(away > 250);
}

/* Fully dispersed fibres have no direction; passive ones a semidefinite tangent; none at all add nothing. */
static void test_dispersion(void)
{
    unsigned long long seed = 42;
    for (int sample = 0; sample < 100; sample++) {
        sb_material m = random_fibres(&seed, 0), alike = sb_material_with_dispersion(m, REAL(1) / 3);
        sb_mat3 f = random_deformation(&seed, 0.3), p = sb_m3_zero(), q = p, d = random_deformation(&seed, 1);
        sb_vec3 a = random_direction(&seed), b = random_direction(&seed);
        sb_real A[81] = {0}, sum = 0;
        CHECK(sb_fibre_stress(&alike, &f, a, &p) && sb_fibre_stress(&alike, &f, b, &q));
        for (int i = 0; i < 9; i++)
            CHECK_NEAR(p.m[i / 3][i % 3], q.m[i / 3][i % 3], scene_tolerance(1e-12, 100) * largest_of(p.m[0], 9));
        CHECK(sb_fibre_tangent(&m, &f, a, A));
        for (int i = 0; i < 81; i++)
            sum += d.m[i / 9 / 3][i / 9 % 3] * A[i] * d.m[i % 9 / 3][i % 9 % 3];
        CHECK((double)sum >= -1e2 * (double)SB_EPSILON * largest_of(A, 81));
    }
}

/* Simple shear by 0.5 of mu 1, k1 0.8, k2 2, kappa 0.1 with families at +-0.6 rad (Gasser, Ogden and Holzapfel 2006,
 * worked out apart from this library): P_01 = 0.94244. */
static void test_published_shear(void)
{
    sb_material m = sb_material_neo_hookean_isochoric(REAL(0.5), REAL(0.01), 1000);
    sb_mat3 f = sb_m3_identity(), p;
    f.m[0][1] = REAL(0.5);
    m = sb_material_with_dispersion(sb_material_with_fibres(m, REAL(0.8), 2), REAL(0.1));
    CHECK_OK(sb_material_check(&m, NULL));
    CHECK(sb_material_stress(&m, &f, NULL, &p));
    for (int side = -1; side <= 1; side += 2)
        CHECK(sb_fibre_stress(&m, &f, sb_v3(REAL(cos(0.6)), REAL(side * sin(0.6)), 0), &p));
    CHECK_NEAR(p.m[0][1], 0.94244, 1e-5);
}

static void check_refused(sb_material m, sb_result expected, const char *fragment)
{
    sb_error error;
    memset(&error, 0, sizeof error);
    CHECK_RESULT(sb_material_check(&m, &error), expected);
    if (!CHECK(strstr(error.message, fragment) != NULL))
        printf("  message: %s\n", error.message);
}

static void test_refused_constants(void)
{
    sb_material m = sb_material_neo_hookean(5000, REAL(0.4), 1000), soft = sb_material_corotated(5000, REAL(0.4), 1000);
    check_refused(sb_material_with_dispersion(m, REAL(-0.1)), SB_ERROR_MATERIAL, "dispersion -0.1");
    check_refused(sb_material_with_dispersion(m, REAL(0.34)), SB_ERROR_MATERIAL, "[0, 1/3]");
    check_refused(sb_material_with_contraction(m, -1, 1, 0), SB_ERROR_MATERIAL, "tension -1");
    check_refused(sb_material_with_contraction(m, 1, 1, -1), SB_ERROR_MATERIAL, "width -1");
    check_refused(sb_material_with_contraction(m, 1, 0, 1), SB_ERROR_MATERIAL, "optimum 0");
    check_refused(sb_material_with_contraction(soft, 1, 1, 1), SB_ERROR_MATERIAL, "not hyperelastic");
    check_bad_numbers();
    check_refused(sb_material_with_dispersion(m, REAL(NAN)), SB_ERROR_NOT_FINITE, "dispersion");
    check_refused(sb_material_with_contraction(m, REAL(INFINITY), 1, 1), SB_ERROR_NOT_FINITE, "tension");
}

/* ---- bodies ---- */

static sb_vec3 *directions(const sb_mesh *mesh, double angle)
{
    sb_vec3 *fibres = (sb_vec3 *)malloc((size_t)mesh->element_count * sizeof *fibres);
    for (int e = 0; e < mesh->element_count; e++)
        fibres[e] = sb_v3(REAL(cos(angle)), REAL(sin(angle)), 0);
    return fibres;
}

/* A homogeneous deformation: stress and energy of a body are those of the material and of both families. */
static void test_two_families(void)
{
    static const sb_element_type types[3] = {SB_TET4, SB_TET10, SB_HEX8};
    unsigned long long seed = 43;
    for (int t = 0; t < 3; t++) {
        sb_mesh mesh = scene_box(types[t], 3, 2, 2, sb_v3(3, 2, 2), 0.2);
        sb_vec3 *first = directions(&mesh, 0.5), *second = directions(&mesh, -0.9);
        sb_vec3 *u = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof *u);
        sb_mat3 f = random_deformation(&seed, 0.2), p, found;
        sb_real energy = 0;
        sb_energy whole = {0, 0, 0};
        sb_body_def def = sb_default_body_def();
        sb_body *body;
        def.mesh = &mesh;
        def.material = random_fibres(&seed, 2);
        def.fibres = first;
        def.second_fibres = second;
        body = scene_body(&def);
        for (int i = 0; i < mesh.node_count; i++)
            u[i] = sb_v3_sub(sb_m3_apply(f, mesh.nodes[i]), mesh.nodes[i]);
        CHECK_OK(sb_body_set_displacements(body, u));
        CHECK(sb_material_stress(&def.material, &f, NULL, &p) && sb_fibre_stress(&def.material, &f, first[0], &p) &&
              sb_fibre_stress(&def.material, &f, second[0], &p));
        CHECK(sb_material_energy(&def.material, &f, NULL, &energy) &&
              sb_fibre_energy(&def.material, &f, first[0], &energy) &&
              sb_fibre_energy(&def.material, &f, second[0], &energy));
        p = sb_cauchy_stress(f, p);
        CHECK_OK(sb_body_stress(body, mesh.element_count - 1, 0, &found));
        for (int i = 0; i < 9; i++)
            CHECK_NEAR(found.m[i / 3][i % 3], p.m[i / 3][i % 3], scene_tolerance(1e-11, 1e3) * 1e4);
        CHECK_OK(sb_body_energy(body, &whole));
        CHECK_NEAR(whole.elastic, 12 * (double)energy, scene_tolerance(1e-11, 1e3) * 1e4);
        sb_body_destroy(body);
        free(first);
        free(second);
        free(u);
        sb_mesh_free(&mesh);
    }
}

/* A bar that contracts freely, nearly incompressible: mu (l - 1/l^2) = -T, whose root at T = 0.3 mu is 0.90934; T rises
 * in three steps of the region's tension. Held at its length the same bar pulls with T. */
static void test_contraction(void)
{
    sb_mesh mesh = scene_box(SB_HEX8, 4, 2, 2, sb_v3(REAL(0.4), REAL(0.1), REAL(0.1)), 0.2);
    sb_vec3 *fibres = directions(&mesh, 0);
    const double mu = 1000;
    sb_static_options options = sb_default_static_options();
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    double pull = 0;
    def.mesh = &mesh;
    def.material = sb_material_neo_hookean_isochoric(REAL(mu / 2), REAL(2 / (1e4 * mu)), 1000);
    def.fibres = fibres;
    def.integration = SB_INTEGRATION_BBAR;
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_X);
    scene_fix_plane(body, &mesh, 1, 0, SB_Y);
    scene_fix_plane(body, &mesh, 2, 0, SB_Z);
    options.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-4 : 1e-10);
    for (int step = 1; step <= 3; step++) {
        CHECK_OK(sb_body_set_tension(body, 0, REAL(0.1 * mu * step), NULL));
        CHECK_OK(sb_body_solve_static(body, &options, NULL));
    }
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].x > REAL(0.3999))
            CHECK_NEAR(sb_body_positions(body)[i].x / REAL(0.4), 0.90934, 1e-4);
    sb_body_reset(body);
    for (int i = 0; i < mesh.node_count; i++)
        CHECK_OK(sb_body_hold(body, &i, 1, SB_XYZ, NULL));
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].x > REAL(0.3999))
            pull += (double)sb_body_reactions(body)[i].x;
    CHECK_NEAR(pull, 0.3 * mu * 0.01, scene_tolerance(1e-9, 1e3) * 3);
    sb_body_destroy(body);
    free(fibres);
    sb_mesh_free(&mesh);
}

/* Explicit steps of a free bar whose tension comes and goes: no step is refused, momentum stays 0, and while the
 * tension is constant no energy comes in. */
static void test_explicit(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 6, 2, 2, sb_v3(REAL(0.3), REAL(0.1), REAL(0.1)), 0.2);
    sb_vec3 *fibres = directions(&mesh, 0.2);
    sb_body_def def = sb_default_body_def();
    sb_energy energy = {0, 0, 0};
    double least = 1e30, most = 0;
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_with_contraction(sb_material_neo_hookean(5000, REAL(0.4), 1000), 0, REAL(1.1), 1);
    def.fibres = fibres;
    def.integrator = SB_CENTRAL_DIFFERENCE;
    body = scene_body(&def);
    for (int step = 0; step < 60; step++) {
        if (step % 10 == 0 && step <= 30)
            CHECK_OK(sb_body_set_tension(body, 0, REAL(step == 20 ? 0 : 40 * step + 300), NULL));
        CHECK_OK(sb_body_step(body, REAL(0.005), NULL));
        CHECK_OK(sb_body_energy(body, &energy));
        if (step >= 30) {
            double all = (double)energy.elastic + (double)energy.kinetic;
            least = all < least ? all : least;
            most = all > most ? all : most;
        }
    }
    CHECK(energy.kinetic > 0);
    CHECK_NEAR(most / least, 1, 0.03);
    CHECK_NEAR(sb_v3_norm(sb_body_momentum(body)), 0, scene_tolerance(1e-12, 1e2));
    sb_body_destroy(body);
    free(fibres);
    sb_mesh_free(&mesh);
}

/* Steps with a tension that beats, saved in the middle and replayed: the same bits, also into a body that had neither
 * a second family nor a tension. */
static void test_state_and_recording(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 4, 2, 2, sb_v3(REAL(0.4), REAL(0.1), REAL(0.1)), 0.2);
    sb_vec3 *first = directions(&mesh, 0.4), *second = directions(&mesh, -0.4);
    size_t nodes = (size_t)mesh.node_count * sizeof(sb_vec3), size;
    sb_body_def def = sb_default_body_def();
    sb_body *body, *other;
    sb_recording *recording = NULL;
    unsigned char *state;
    const sb_real g = REAL(0.3), tau = REAL(0.05);
    def.mesh = &mesh;
    def.material = sb_material_with_prony(sb_material_neo_hookean(5000, REAL(0.4), 1000), &g, &tau, 1);
    def.material = sb_material_with_dispersion(sb_material_with_fibres(def.material, 900, 1), REAL(0.1));
    def.fibres = first;
    body = scene_body(&def);
    other = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_recording_start(body, 1, NULL, &recording, NULL));
    CHECK_OK(sb_body_set_second_fibres(body, second, NULL));
    for (int step = 0; step < 6; step++) {
        CHECK_OK(sb_body_set_tension(body, 0, REAL(300 * (step % 4)), NULL));
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    }
    size = sb_body_state_size(body);
    state = (unsigned char *)malloc(size);
    CHECK_OK(sb_body_state_save(body, state, size));
    CHECK_OK(sb_body_state_load(other, state, size, NULL));
    for (int step = 0; step < 3; step++) {
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        CHECK_OK(sb_body_step(other, REAL(0.01), NULL));
    }
    CHECK(memcmp(sb_body_positions(body), sb_body_positions(other), nodes) == 0);
    CHECK(scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count) > 1e-4);
    CHECK_OK(sb_body_set_second_fibres(body, NULL, NULL));
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    CHECK(memcmp(sb_body_positions(body), sb_body_positions(other), nodes) != 0);
    CHECK_OK(sb_recording_replay(recording, other, NULL));
    CHECK(memcmp(sb_body_positions(body), sb_body_positions(other), nodes) == 0);
    sb_recording_destroy(recording);
    sb_body_destroy(body);
    sb_body_destroy(other);
    free(state);
    free(first);
    free(second);
    sb_mesh_free(&mesh);
}

static void test_failures(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 2, 1, 1, sb_v3(2, 1, 1), 0);
    sb_vec3 *fibres = directions(&mesh, 0);
    scene_memory memory = {0, 0, 0, 0};
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_error error;
    def.mesh = &mesh;
    def.allocator = scene_allocator(&memory);
    def.material = sb_material_neo_hookean(5000, REAL(0.4), 1000);
    def.second_fibres = fibres;
    CHECK_RESULT(sb_body_create(&def, &body, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "first one") != NULL);
    def.fibres = fibres;
    def.slack = REAL(0.1);
    CHECK_RESULT(sb_body_create(&def, &body, &error), SB_ERROR_UNSUPPORTED);
    def.second_fibres = NULL;
    CHECK_OK(sb_body_create(&def, &body, &error));
    CHECK_RESULT(sb_body_set_second_fibres(body, fibres, &error), SB_ERROR_UNSUPPORTED);
    CHECK_OK(sb_body_set_second_fibres(body, NULL, &error));
    sb_body_destroy(body);
    def.slack = 0;
    def.second_fibres = fibres;
    for (int n = 1;; n++) {
        memory.calls = 0;
        memory.fail_at = n;
        body = NULL;
        if (sb_body_create(&def, &body, &error) == SB_OK)
            break;
        CHECK_RESULT(error.result, SB_ERROR_MEMORY);
        CHECK(!body && memory.live == 0);
    }
    memory.fail_at = 0;
    CHECK_RESULT(sb_body_set_tension(body, 5, 1, &error), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_set_tension(body, 0, -1, &error), SB_ERROR_MATERIAL);
    CHECK_RESULT(sb_body_set_tension(NULL, 0, 1, &error), SB_ERROR_ARGUMENT);
    CHECK_OK(sb_body_set_tension(body, 0, 1, &error));
    CHECK_RESULT(sb_body_set_fibres(body, NULL, &error), SB_ERROR_MATERIAL);
    CHECK_OK(sb_body_set_tension(body, 0, 0, &error));
    CHECK_OK(sb_body_set_fibres(body, NULL, &error)); /* both families */
    CHECK_RESULT(sb_body_set_tension(body, 0, 1, &error), SB_ERROR_MATERIAL);
    CHECK(strstr(error.message, "directions") != NULL);
    CHECK_RESULT(sb_body_set_second_fibres(body, fibres, &error), SB_ERROR_ARGUMENT);
    CHECK_OK(sb_body_set_fibres(body, fibres, &error));
    memory.calls = 0;
    memory.fail_at = 1;
    CHECK_RESULT(sb_body_set_second_fibres(body, fibres, &error), SB_ERROR_MEMORY);
    memory.fail_at = 0;
    fibres[1].y = REAL(NAN);
    CHECK_RESULT(sb_body_set_second_fibres(body, fibres, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.element, 1);
    sb_body_destroy(body);
    CHECK_INT(memory.live, 0);
    free(fibres);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(fibres, {"derivatives", test_derivatives}, {"dispersion", test_dispersion},
            {"published shear", test_published_shear}, {"refused constants", test_refused_constants},
            {"two families", test_two_families}, {"contraction", test_contraction}, {"explicit steps", test_explicit},
            {"state and recording", test_state_and_recording}, {"failures", test_failures});
