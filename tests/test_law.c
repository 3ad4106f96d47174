/* Material laws of the caller's own: against the built-in models point by point and in bodies, Gent's law against its
 * closed form, what is refused and how it is named, states and recordings by name, threads, memory. */
#include <stdlib.h>

#include "softbody.h"

#include "check.h"
#include "gent.h"
#include "scene.h"

/* ---- laws: a built-in material in disguise, and Gent's ---- */

static int as_energy(void *user, const sb_mat3 *F, sb_real *W)
{
    return sb_material_energy((const sb_material *)user, F, NULL, W);
}

static int as_stress(void *user, const sb_mat3 *F, sb_mat3 *P)
{
    return sb_material_stress((const sb_material *)user, F, NULL, P);
}

static int as_tangent(void *user, const sb_mat3 *F, sb_real *A)
{
    return sb_material_tangent((const sb_material *)user, F, NULL, SB_TANGENT_EXACT, A);
}

static sb_material_law disguise(const char *name, sb_material *material)
{
    sb_material_law law;
    law.name = name;
    law.user = material;
    law.energy = as_energy;
    law.stress = as_stress;
    law.tangent = as_tangent;
    return law;
}

/* ---- points ---- */

static sb_mat3 random_F(unsigned long long *seed, double spread)
{
    sb_mat3 f = sb_m3_identity();
    for (int i = 0; i < 9; i++)
        f.m[i / 3][i % 3] += REAL(check_random_in(seed, -spread, spread));
    return f;
}

static double largest_gap(const sb_real *a, const sb_real *b, int count)
{
    double most = 0, size = 0;
    for (int i = 0; i < count; i++) {
        most = fmax(most, fabs((double)a[i] - (double)b[i]));
        size = fmax(size, fabs((double)b[i]));
    }
    return size > 0 ? most / size : most;
}

/* The disguised material is the material, its tangent by differences is near it, and both projections agree. */
static void test_points(void)
{
    unsigned long long seed = 31;
    for (int round = 0; round < 60; round++) {
        double young = exp(check_random_in(&seed, 2, 14)), nu = check_random_in(&seed, 0, 0.45);
        sb_material own = round % 2 ? sb_material_neo_hookean(REAL(young), REAL(nu), 1000)
                                    : sb_material_svk(REAL(young), REAL(nu), 1000);
        sb_material_law law = disguise("disguise", &own);
        sb_material custom = sb_material_custom(&law, 0, 1000), rough;
        sb_mat3 f = random_F(&seed, 0.3), p, expected;
        sb_real w, energy, a[81], b[81];
        CHECK_OK(sb_material_check(&custom, NULL));
        CHECK_NEAR((double)custom.mu / (double)own.mu, 1, scene_tolerance(1e-12, 100));
        CHECK_NEAR((double)sb_material_bulk(&custom) / (double)sb_material_bulk(&own), 1, scene_tolerance(1e-12, 300));
        if (!CHECK(sb_material_energy(&custom, &f, NULL, &w) && sb_material_energy(&own, &f, NULL, &energy)) ||
            !CHECK(sb_material_stress(&custom, &f, NULL, &p) && sb_material_stress(&own, &f, NULL, &expected)))
            continue;
        CHECK_NEAR((double)w / (double)energy, 1, scene_tolerance(1e-14, 4));
        CHECK_NEAR(largest_gap(p.m[0], expected.m[0], 9), 0, scene_tolerance(1e-14, 4));
        for (int kind = SB_TANGENT_EXACT; kind <= SB_TANGENT_SPD; kind++) {
            CHECK(sb_material_tangent(&custom, &f, NULL, (sb_tangent_kind)kind, a));
            CHECK(sb_material_tangent(&own, &f, NULL, (sb_tangent_kind)kind, b));
            CHECK_NEAR(largest_gap(a, b, 81), 0, scene_tolerance(1e-12, 300));
        }
        law.tangent = NULL;
        rough = sb_material_custom(&law, 0, 1000);
        CHECK_OK(sb_material_check(&rough, NULL));
        CHECK(sb_material_tangent(&rough, &f, NULL, SB_TANGENT_SPD, a));
        CHECK_NEAR(largest_gap(a, b, 81), 0, sizeof(sb_real) == 4 ? 5e-3 : 1e-8);
        for (int i = 0; i < 81; i++)
            CHECK(a[i] == a[9 * (i % 9) + i / 9]);
    }
}

/* Laws that are steep are none the worse for it: Fung's with exponents up to 100. */
static void test_steep(void)
{
    static const double exponents[4] = {1, 10, 40, 100};
    for (int k = 0; k < 4; k++) {
        sb_material own = sb_material_fung(500, REAL(exponents[k]), REAL(1e-4), 1000);
        sb_material_law law = disguise("steep", &own);
        sb_material custom = sb_material_custom(&law, 0, 1000);
        CHECK_OK(sb_material_check(&custom, NULL));
    }
}

/* ---- refusals ---- */

static int wrong_kind; /* what the laws below get wrong */

static int wrong_energy(void *user, const sb_mat3 *F, sb_real *W)
{
    if (!as_energy(user, F, W))
        return 0;
    if (wrong_kind == 1)
        *W *= REAL(1.01);
    if (wrong_kind == 4)
        *W += 100;
    return wrong_kind != 6;
}

static int wrong_stress(void *user, const sb_mat3 *F, sb_mat3 *P)
{
    if (!as_stress(user, F, P))
        return 0;
    if (wrong_kind == 2)
        P->m[1][2] += REAL(0.4) * (P->m[1][2] - P->m[2][1]);
    if (wrong_kind == 5)
        P->m[1][2] += 50;
    return 1;
}

static int wrong_tangent(void *user, const sb_mat3 *F, sb_real *A)
{
    if (!as_tangent(user, F, A))
        return 0;
    if (wrong_kind == 3)
        A[9 * 1 + 4] = -A[9 * 1 + 4] + A[0] / 10; /* one of 81 */
    return 1;
}

/* A law that is wrong by little is refused, with its name and what is wrong about it. */
static void test_wrong_laws(void)
{
    static const char *const words[7] = {"",
                                         "its stress P[",
                                         "its stress P[",
                                         "its tangent dP[0][1]/dF[1][1]",
                                         "energy",
                                         "its stress P[1][2] at rest",
                                         "no value at rest"};
    sb_material own = sb_material_neo_hookean(5000, REAL(0.3), 1000), custom;
    sb_material linear = sb_material_linear(5000, REAL(0.3), 1000);
    sb_material_law law = disguise("liver of mine", &own), plain = disguise("small strain", &linear);
    sb_error error;
    law.energy = wrong_energy, law.stress = wrong_stress, law.tangent = wrong_tangent;
    for (wrong_kind = 0; wrong_kind < 7; wrong_kind++) {
        custom = sb_material_custom(&law, 0, 1000);
        CHECK_RESULT(sb_material_check(&custom, &error), wrong_kind ? SB_ERROR_MATERIAL : SB_OK);
        CHECK(!wrong_kind || strstr(error.message, words[wrong_kind]) != NULL);
        CHECK(!wrong_kind || strstr(error.message, "liver of mine") != NULL);
    }
    wrong_kind = 0;
    custom = sb_material_custom(&plain, 0, 1000);
    CHECK_RESULT(sb_material_check(&custom, &error), SB_ERROR_MATERIAL);
    CHECK(strstr(error.message, "small strain depends on the observer") != NULL);
}

/* What is wrong already at rest is said of the law, not of moduli that the caller never gave; a law without a call has
 * no values. */
static int spoilt_kind; /* of the laws below */

static int spoilt_stress(void *user, const sb_mat3 *F, sb_mat3 *P)
{
    if (spoilt_kind == 3 || !as_stress(user, F, P))
        return 0;
    if (spoilt_kind == 0 || spoilt_kind == 2)
        *P = sb_m3_scale(spoilt_kind ? -1 : REAL(NAN), *P);
    return 1;
}

static int spoilt_tangent(void *user, const sb_mat3 *F, sb_real *A)
{
    int found = as_tangent(user, F, A);
    A[40] = REAL(NAN);
    return found;
}

static void test_spoilt_at_rest(void)
{
    static const char *const words[4] = {"no finite stress", "no finite stress", "its shear modulus at rest",
                                         "no finite stress"};
    sb_material own = sb_material_neo_hookean(5000, REAL(0.3), 1000), custom;
    sb_material_law law = disguise("liver of mine", &own);
    sb_mat3 F = sb_m3_identity(), P;
    sb_real W, A[81];
    sb_error error;
    law.stress = spoilt_stress;
    for (spoilt_kind = 0; spoilt_kind < 4; spoilt_kind++) {
        law.tangent = spoilt_kind == 1 ? spoilt_tangent : NULL;
        custom = sb_material_custom(&law, 100, 1000);
        CHECK_RESULT(sb_material_check(&custom, &error), SB_ERROR_MATERIAL);
        CHECK(strstr(error.message, "liver of mine") != NULL && strstr(error.message, words[spoilt_kind]) != NULL);
    }
    for (int k = 0; k < 3; k++) {
        if (k == 0)
            law.energy = NULL;
        else
            law.stress = NULL;
        custom = sb_material_custom(k < 2 ? &law : NULL, 100, 1000);
        CHECK(!sb_material_energy(&custom, &F, NULL, &W) && !sb_material_stress(&custom, &F, NULL, &P));
        CHECK(!sb_material_tangent(&custom, &F, NULL, SB_TANGENT_SPD, A));
    }
}

/* A law that nothing of the volume is in, forgotten to be given a bulk modulus: rounding does not decide. */
static void test_no_volume(void)
{
    static const double shear[5] = {0.7, 1, 777.7, 1e5, 3.3e6};
    for (int k = 0; k < 10; k++) {
        sb_material own = sb_material_neo_hookean_isochoric(REAL(shear[k / 2] / 2), SB_REAL_MAX, 1000), custom;
        sb_material_law law = disguise("deviator", &own);
        sb_error error;
        if (k % 2)
            law.tangent = NULL;
        custom = sb_material_custom(&law, 0, 1000);
        CHECK_RESULT(sb_material_check(&custom, &error), SB_ERROR_MATERIAL);
        CHECK(strstr(error.message, "deviator") != NULL && strstr(error.message, "volume") != NULL);
        custom = sb_material_custom(&law, REAL(shear[k / 2]), 1000);
        CHECK_OK(sb_material_check(&custom, &error));
    }
}

static void test_refused_arguments(void)
{
    sb_material own = sb_material_neo_hookean(5000, REAL(0.3), 1000), custom;
    sb_material_law law = disguise("own", &own), broken;
    sb_error error;
    custom = sb_material_custom(NULL, 0, 1000);
    CHECK_RESULT(sb_material_check(&custom, &error), SB_ERROR_MATERIAL);
    CHECK(strstr(error.message, "no law") != NULL);
    for (int k = 0; k < 4; k++) {
        broken = law;
        if (k < 2)
            broken.name = k ? "" : NULL;
        else if (k == 2)
            broken.energy = NULL;
        else
            broken.stress = NULL;
        custom = sb_material_custom(&broken, 0, 1000);
        CHECK_RESULT(sb_material_check(&custom, &error), SB_ERROR_ARGUMENT);
    }
    custom = sb_material_custom(&law, -1, 1000);
    CHECK_RESULT(sb_material_check(&custom, NULL), SB_ERROR_MATERIAL);
    custom = sb_material_custom(&law, REAL(NAN), 1000);
    CHECK_RESULT(sb_material_check(&custom, NULL), SB_ERROR_NOT_FINITE);
    custom = sb_material_custom(&law, 0, 1000);
    custom.law_scale = 2; /* mu is that of 1 */
    CHECK_RESULT(sb_material_check(&custom, &error), SB_ERROR_MATERIAL);
    CHECK(strstr(error.message, "bulk modulus") != NULL);
    custom.mu *= 2, custom.lambda *= 2;
    CHECK_OK(sb_material_check(&custom, NULL));
}

/* ---- bodies ---- */

static sb_body *pulled_body(const sb_mesh *mesh, sb_material material, sb_integrator integrator, int is_mean)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    def.mesh = mesh;
    def.material = material;
    def.integrator = integrator;
    def.integration = is_mean ? SB_INTEGRATION_BBAR : SB_INTEGRATION_AUTO;
    def.gravity = sb_v3(REAL(0.3), REAL(-4), REAL(0.5));
    def.tolerance = REAL(scene_tolerance(1e-12, 100));
    def.newton_tolerance = REAL(scene_tolerance(1e-11, 1000));
    def.max_newton = integrator == SB_CENTRAL_DIFFERENCE ? 1 : 8;
    def.max_iterations = 5000;
    body = scene_body(&def);
    if (body)
        scene_fix_plane(body, mesh, 0, 0, SB_XYZ);
    return body;
}

/* Steps and a static solve of a material and of the law that says the same; the static solve's stress too. */
static void compare_bodies(const sb_mesh *mesh, sb_material own, sb_material custom, sb_integrator integrator,
                           int is_mean)
{
    sb_static_options options = sb_default_static_options();
    sb_body *a = pulled_body(mesh, own, integrator, is_mean);
    sb_body *b = pulled_body(mesh, custom, integrator, is_mean);
    sb_mat3 sa, sb;
    double size;
    options.tolerance = REAL(scene_tolerance(1e-11, 1000));
    if (!CHECK(a && b))
        return;
    for (int s = 0; s < 3; s++) {
        CHECK_OK(sb_body_step(a, REAL(0.01), NULL));
        CHECK_OK(sb_body_step(b, REAL(0.01), NULL));
    }
    size = scene_distance(sb_body_positions(a), mesh->nodes, mesh->node_count);
    CHECK(size > 1e-5);
    CHECK_NEAR(scene_distance(sb_body_positions(a), sb_body_positions(b), mesh->node_count) / size, 0,
               scene_tolerance(1e-8, 3e4));
    CHECK_OK(sb_body_solve_static(a, &options, NULL));
    CHECK_OK(sb_body_solve_static(b, &options, NULL));
    size = scene_distance(sb_body_positions(a), mesh->nodes, mesh->node_count);
    CHECK_NEAR(scene_distance(sb_body_positions(a), sb_body_positions(b), mesh->node_count) / size, 0,
               scene_tolerance(1e-7, 1e5));
    CHECK_OK(sb_body_stress(a, 0, 0, &sa));
    CHECK_OK(sb_body_stress(b, 0, 0, &sb));
    CHECK_NEAR(largest_gap(sb.m[0], sa.m[0], 9), 0, scene_tolerance(1e-6, 1e6));
    sb_body_destroy(a);
    sb_body_destroy(b);
}

/* A built-in model and its disguise move alike: shaken meshes of every element, implicit and explicit steps; the law's
 * share of an isochoric model with its bulk modulus in the library's hands, on B-bar elements, relaxing. */
static void test_bodies(void)
{
    static const sb_element_type types[4] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20};
    static const sb_integrator integrators[3] = {SB_NEWMARK, SB_EULER, SB_CENTRAL_DIFFERENCE};
    const sb_real g[2] = {REAL(0.3), REAL(0.2)}, tau[2] = {REAL(0.02), REAL(0.5)};
    for (int t = 0; t < 4; t++) {
        sb_mesh mesh = scene_box(types[t], 2, t < 3 ? 2 : 1, 1, sb_v3(REAL(0.09), REAL(0.05), REAL(0.04)), 0.15);
        sb_material own = sb_material_neo_hookean(REAL(9000), REAL(0.35), 1000);
        sb_material whole = sb_material_neo_hookean_isochoric(1500, REAL(1e-5), 1000), deviator = whole;
        sb_material_law law = disguise("own", &own), isochoric = disguise("deviator", &deviator);
        sb_material custom = sb_material_custom(&law, 0, 1000), split;
        compare_bodies(&mesh, own, custom, integrators[t % 3], 0);
        deviator.d1 = SB_REAL_MAX; /* no bulk term */
        split = sb_material_custom(&isochoric, REAL(2e5), 1000);
        CHECK_NEAR((double)split.lambda / (double)whole.lambda, 1, scene_tolerance(1e-9, 2000));
        compare_bodies(&mesh, whole, split, SB_NEWMARK, t > 0);
        compare_bodies(&mesh, sb_material_with_prony(whole, g, tau, 2), sb_material_with_prony(split, g, tau, 2),
                       SB_EULER, t > 0);
        sb_mesh_free(&mesh);
    }
}

/* Gent's law in simple shear: P_01 = mu gamma/(1 - gamma^2/limit), volume kept, whatever the mesh. */
static void test_gent(void)
{
    static const sb_element_type types[4] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20};
    unsigned long long seed = 77;
    for (int t = 0; t < 4; t++) {
        gent g = {REAL(check_random_in(&seed, 800, 3000)), REAL(check_random_in(&seed, 0.8, 3)),
                  REAL(check_random_in(&seed, 5e3, 2e4))};
        sb_material_law law = gent_law(&g);
        sb_mesh mesh = scene_box(types[t], 2, 2, 2, sb_v3(REAL(0.03), REAL(0.02), REAL(0.04)), 0.2);
        sb_static_options options = sb_default_static_options();
        double gamma = 0.9 * sqrt((double)g.limit),
               expected = (double)g.mu * gamma / (1 - gamma * gamma / (double)g.limit);
        sb_body *body = pulled_body(&mesh, sb_material_custom(&law, 0, 1000), SB_NEWMARK, 0);
        options.tolerance = REAL(scene_tolerance(1e-10, 1000));
        options.load_steps = 6;
        if (!CHECK(body))
            return;
        CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, 0)));
        scene_fix_boundary(body, &mesh);
        for (int i = 0; i < mesh.node_count; i++) {
            sb_vec3 u = sb_v3(REAL(gamma) * mesh.nodes[i].y, 0, 0);
            if (sb_body_supports(body)[i])
                CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u, 1));
        }
        CHECK_OK(sb_body_solve_static(body, &options, NULL));
        for (int e = 0; e < mesh.element_count; e++) {
            sb_mat3 sigma;
            CHECK_OK(sb_body_stress(body, e, 0, &sigma));
            CHECK_NEAR((double)sigma.m[0][1] / expected, 1, scene_tolerance(1e-7, 1e5));
        }
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* Drawn beyond what the law admits a step fails and is undone; drawn less it goes on. */
static void test_beyond(void)
{
    gent g = {1000, REAL(0.5), 5000};
    sb_material_law law = gent_law(&g);
    sb_mesh mesh = scene_box(SB_TET10, 3, 2, 2, sb_v3(REAL(0.06), REAL(0.03), REAL(0.03)), 0.1);
    sb_body *body = pulled_body(&mesh, sb_material_custom(&law, 0, 1000), SB_NEWMARK, 0);
    sb_vec3 *before = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof *before);
    sb_vec3 far_away = sb_v3(REAL(0.1), 0, 0), near_by = sb_v3(REAL(0.005), 0, 0);
    sb_step_info info;
    if (CHECK(body && before)) {
        for (int i = 0; i < mesh.node_count; i++)
            if ((double)mesh.nodes[i].x > 0.0599)
                CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &near_by, 1));
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        memcpy(before, sb_body_positions(body), (size_t)mesh.node_count * sizeof *before);
        for (int i = 0; i < mesh.node_count; i++)
            if ((double)mesh.nodes[i].x > 0.0599)
                CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &far_away, 1));
        CHECK(sb_body_step(body, REAL(0.01), &info) != SB_OK);
        CHECK(memcmp(before, sb_body_positions(body), (size_t)mesh.node_count * sizeof *before) == 0);
        for (int i = 0; i < mesh.node_count; i++)
            if ((double)mesh.nodes[i].x > 0.0599)
                CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &near_by, 1));
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    }
    sb_body_destroy(body);
    free(before);
    sb_mesh_free(&mesh);
}

/* A law's stiffness is identified from how far a body sags, from too low as from too high, with a bulk term of the
 * library and without. */
static void test_identified(void)
{
    static const double starts[3] = {0.2, 0.9, 4};
    gent g = {REAL(4e4), 2, REAL(1e5)};
    sb_material_law law = gent_law(&g);
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(REAL(0.09), REAL(0.03), REAL(0.03)), 0.1);
    for (int k = 0; k < 6; k++) {
        sb_body *body = pulled_body(&mesh, sb_material_custom(&law, REAL(k % 2 ? 0 : 2e4), 1000), SB_NEWMARK, 0);
        sb_material made = sb_material_custom(&law, REAL(k % 2 ? 0 : 2e4), 1000);
        sb_identify_def def = sb_default_identify_def();
        sb_static_options options = sb_default_static_options();
        int start[2] = {0, 1}, node = mesh.node_count - 1;
        sb_real one = 1, value = REAL(starts[k / 2]) * sb_material_young(&made), deviation;
        sb_mapping row;
        sb_parameter young;
        sb_measurement seen;
        sb_vec3 tip;
        sb_error error;
        memset(&row, 0, sizeof row);
        memset(&young, 0, sizeof young);
        memset(&seen, 0, sizeof seen);
        options.tolerance = REAL(scene_tolerance(1e-10, 1000));
        if (!CHECK(body) || !CHECK_OK(sb_body_solve_static(body, &options, NULL)))
            break;
        tip = sb_body_positions(body)[node];
        row.row_count = 1, row.row_start = start, row.nodes = &node, row.weights = &one;
        young.kind = SB_PARAMETER_YOUNG;
        seen.rows = &row, seen.points = &tip, seen.sigma_point = REAL(1e-4);
        def.body = body, def.parameters = &young, def.count = 1, def.measurements = &seen;
        CHECK_OK(sb_identify(&def, &value, &deviation, NULL, NULL, &error));
        CHECK_NEAR((double)value / (double)sb_material_young(&made), 1, scene_tolerance(1e-5, 5e4));
        sb_body_destroy(body);
    }
    sb_mesh_free(&mesh);
}

/* ---- states and recordings ---- */

/* A state with a law loads where the body knows one of that name, to the same bits, and nowhere else. */
static void test_state(void)
{
    gent g = {1500, 2, 6000};
    sb_material_law law = gent_law(&g);
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(REAL(0.06), REAL(0.03), REAL(0.03)), 0.1);
    sb_material custom = sb_material_custom(&law, 0, 1000), rubber = sb_material_neo_hookean(4000, REAL(0.3), 900);
    sb_material knowing = rubber;
    sb_body *body = pulled_body(&mesh, custom, SB_NEWMARK, 0), *stranger = pulled_body(&mesh, rubber, SB_NEWMARK, 0),
            *friend_;
    size_t size = sb_body_state_size(body);
    void *state = malloc(size);
    uint64_t hash;
    sb_error error;
    knowing.law = &law;
    friend_ = pulled_body(&mesh, knowing, SB_NEWMARK, 0);
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    if (CHECK(state) && CHECK_OK(sb_body_state_save(body, state, size))) {
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        hash = sb_body_state_hash(stranger);
        CHECK_RESULT(sb_body_state_load(stranger, state, size, &error), SB_ERROR_MATERIAL);
        CHECK(strstr(error.message, "law") != NULL);
        CHECK(sb_body_state_hash(stranger) == hash);
        CHECK_OK(sb_body_state_load(friend_, state, size, &error));
        CHECK_OK(sb_body_step(friend_, REAL(0.01), NULL));
        CHECK(sb_body_state_hash(friend_) == sb_body_state_hash(body));
    }
    free(state);
    sb_body_destroy(body);
    sb_body_destroy(stranger);
    sb_body_destroy(friend_);
    sb_mesh_free(&mesh);
}

/* A recording in which a law comes in later is replayed where it is known. */
static void test_recording(void)
{
    gent g = {1500, 2, 6000};
    sb_material_law law = gent_law(&g);
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(REAL(0.06), REAL(0.03), REAL(0.03)), 0.1);
    sb_material custom = sb_material_custom(&law, 100, 1000), rubber = sb_material_neo_hookean(4000, REAL(0.3), 900);
    sb_material knowing = rubber;
    sb_body *body = pulled_body(&mesh, rubber, SB_NEWMARK, 0), *stranger = pulled_body(&mesh, rubber, SB_NEWMARK, 0),
            *friend_;
    sb_recording *recording = NULL;
    sb_recording_report report;
    knowing.law = &law;
    friend_ = pulled_body(&mesh, knowing, SB_NEWMARK, 0);
    if (CHECK_OK(sb_recording_start(body, 0, NULL, &recording, NULL))) {
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        CHECK_OK(sb_body_set_material(body, &custom, NULL));
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        sb_recording_stop(recording);
        CHECK_OK(sb_recording_replay(recording, friend_, &report));
        CHECK(sb_body_state_hash(friend_) == sb_body_state_hash(body));
        CHECK(sb_recording_replay(recording, stranger, &report) != SB_OK);
        CHECK(strstr(report.error.message, "law") != NULL);
    }
    sb_recording_destroy(recording);
    sb_body_destroy(body);
    sb_body_destroy(stranger);
    sb_body_destroy(friend_);
    sb_mesh_free(&mesh);
}

/* ---- threads, memory ---- */

static void test_threads(void)
{
    gent g = {1500, 2, 6000};
    sb_material_law law = gent_law(&g);
    uint64_t expected = 0;
    for (int workers = 1; workers <= 5; workers += 2) {
        sb_mesh mesh = scene_box(SB_TET10, 4, 2, 2, sb_v3(REAL(0.08), REAL(0.03), REAL(0.03)), 0.1);
        sb_body_def def = sb_default_body_def();
        sb_body *body;
        def.mesh = &mesh;
        def.material = sb_material_custom(&law, 0, 1000);
        def.gravity = sb_v3(0, REAL(-9), 1);
        def.jobs = scene_jobs(&workers);
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        for (int s = 0; s < 3; s++)
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        CHECK(workers == 1 || sb_body_state_hash(body) == expected);
        expected = sb_body_state_hash(body);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* Every allocation fails in turn; two laws of one name; steps allocate nothing. */
static void test_memory(void)
{
    gent g = {1500, 2, 6000};
    sb_material_law law = gent_law(&g), other = law;
    sb_mesh mesh = scene_box(SB_TET4, 2, 1, 1, sb_v3(REAL(0.06), REAL(0.03), REAL(0.03)), 0);
    sb_material custom = sb_material_custom(&law, 0, 1000), second;
    scene_memory memory = {0, 0, 0, 0};
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_error error;
    uint64_t hash;
    def.mesh = &mesh;
    def.allocator = scene_allocator(&memory);
    def.material = custom;
    for (int n = 1;; n++) {
        memory.calls = 0;
        memory.fail_at = n;
        body = NULL;
        if (sb_body_create(&def, &body, &error) == SB_OK)
            break;
        CHECK_RESULT(error.result, SB_ERROR_MEMORY);
        CHECK(!body && memory.live == 0);
    }
    second = sb_material_custom(&other, 0, 1000);
    hash = sb_body_state_hash(body);
    CHECK_RESULT(sb_body_set_material(body, &second, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "gent") != NULL);
    other.name = "another";
    memory.calls = 0;
    memory.fail_at = 1;
    CHECK_RESULT(sb_body_set_material(body, &second, &error), SB_ERROR_MEMORY);
    CHECK(sb_body_state_hash(body) == hash);
    memory.fail_at = 0;
    CHECK_OK(sb_body_set_region_material(body, 0, &second, &error));
    CHECK_OK(sb_body_set_region_material(body, 0, &custom, &error));
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    memory.calls = 0;
    memory.fail_at = 1;
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    memory.fail_at = 0;
    sb_body_destroy(body);
    CHECK_INT(memory.live, 0);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(law, {"points", test_points}, {"steep laws", test_steep}, {"wrong laws", test_wrong_laws},
            {"spoilt at rest", test_spoilt_at_rest}, {"no volume", test_no_volume},
            {"refused arguments", test_refused_arguments}, {"bodies", test_bodies}, {"Gent in shear", test_gent},
            {"beyond what it admits", test_beyond}, {"identified", test_identified}, {"state", test_state},
            {"recording", test_recording}, {"threads", test_threads}, {"memory", test_memory});
