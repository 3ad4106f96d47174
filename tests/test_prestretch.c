/* Materials that are strained where the mesh is at rest: derivatives by differences, closed forms, states. */
#include "check.h"
#include "random_case.h"

#include "verification_scene.h"

static sb_material hyperelastic(int k)
{
    static const sb_real mu[2] = {2000, 300}, alpha[2] = {2, -3};
    switch (k) {
    case 0: return sb_material_svk(REAL(1e4), REAL(0.3), 1000);
    case 1: return sb_material_neo_hookean(REAL(1e4), REAL(0.3), 1000);
    case 2: return sb_material_neo_hookean_isochoric(1700, REAL(2e-4), 1000);
    case 3: return sb_material_stable_neo_hookean(REAL(1e4), REAL(0.3), 1000);
    case 4: return sb_material_mooney_rivlin(1500, 300, REAL(2e-4), 1000);
    case 5: return sb_material_reduced_polynomial(1500, 700, 100, REAL(2e-4), 1000);
    case 6: return sb_material_ogden(mu, alpha, 2, REAL(2e-4), 1000);
    default: return sb_material_fung(1500, 2, REAL(2e-4), 1000);
    }
}

static sb_mat3 random_strain(unsigned long long *seed, double size)
{
    sb_mat3 f = sb_m3_identity();
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            f.m[i][j] += REAL(check_random_in(seed, -size, size));
    return f;
}

/* W and P of matrix and fibres. */
static double whole_energy(const sb_material *m, sb_mat3 f, sb_vec3 a)
{
    sb_real w = 0;
    CHECK(sb_material_energy(m, &f, NULL, &w) && sb_fibre_energy(m, &f, a, &w));
    return (double)w;
}

static sb_mat3 whole_stress(const sb_material *m, sb_mat3 f, sb_vec3 a)
{
    sb_mat3 p = sb_m3_zero();
    CHECK(sb_material_stress(m, &f, NULL, &p) && sb_fibre_stress(m, &f, a, &p));
    return p;
}

/* P = dW/dF and A = dP/dF, fibres included; the projected tangent is semidefinite; W'(F) = W(F G) / det G. */
static void test_derivatives(void)
{
    const double step = 1e-6;
    unsigned long long seed = 5;
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("differences need double");
        return;
    }
    for (int round = 0; round < check_rounds(160); round++) {
        sb_mat3 g = random_strain(&seed, 0.15), f = random_strain(&seed, 0.15), d = random_strain(&seed, 0.5), p, up,
                down;
        sb_material plain = hyperelastic(round % 8), m;
        sb_vec3 a = random_direction(&seed), inner;
        sb_real tangent[81], safe[81];
        double slope, along = 0, quadratic = 0, off = 0, size = 0;
        if (round % 3)
            plain = sb_material_with_fibres(plain, 3000, REAL(round % 2 ? 1.5 : 0));
        if (round % 3 == 2)
            plain =
                sb_material_with_contraction(sb_material_with_dispersion(plain, REAL(0.1)), 500, REAL(1.1), REAL(0.8));
        m = sb_material_with_prestretch(plain, g);
        CHECK_OK(sb_material_check(&m, NULL));
        inner = sb_m3_apply(sb_m3_inverse(g), a);
        CHECK_NEAR(whole_energy(&m, f, a), whole_energy(&plain, sb_m3_mul(f, g), inner) / (double)sb_m3_det(g),
                   1e-10 * (1 + fabs(whole_energy(&m, f, a))));
        p = whole_stress(&m, f, a);
        up = sb_m3_add(f, sb_m3_scale(REAL(step), d)), down = sb_m3_add(f, sb_m3_scale(REAL(-step), d));
        slope = (whole_energy(&m, up, a) - whole_energy(&m, down, a)) / (2 * step);
        CHECK_NEAR(sb_m3_ddot(p, d), slope, 1e-6 * (fabs(slope) + 1e3));
        CHECK(sb_material_tangent(&m, &f, NULL, SB_TANGENT_EXACT, tangent) && sb_fibre_tangent(&m, &f, a, tangent));
        CHECK(sb_material_tangent(&m, &f, NULL, SB_TANGENT_SPD, safe));
        up = whole_stress(&m, up, a), down = whole_stress(&m, down, a);
        for (int i = 0; i < 9; i++) {
            double sum = 0;
            for (int j = 0; j < 9; j++) {
                sum += (double)tangent[9 * i + j] * (double)d.m[j / 3][j % 3];
                quadratic += (double)(safe[9 * i + j] * d.m[i / 3][i % 3] * d.m[j / 3][j % 3]);
                off = fmax(off, fabs((double)(tangent[9 * i + j] - tangent[9 * j + i])));
                size = fmax(size, fabs((double)tangent[9 * i + j]));
            }
            along = ((double)up.m[i / 3][i % 3] - (double)down.m[i / 3][i % 3]) / (2 * step);
            CHECK_NEAR(sum, along, 1e-6 * size);
        }
        CHECK(off == 0);
        CHECK(quadratic >= -1e-9 * size);
    }
}

/* ---- bodies ---- */

static sb_mat3 diagonal(double x, double y, double z)
{
    sb_mat3 g = sb_m3_zero();
    g.m[0][0] = REAL(x), g.m[1][1] = REAL(y), g.m[2][2] = REAL(z);
    return g;
}

static sb_body *strained_body(const sb_mesh *mesh, sb_material material, sb_integration integration)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = material;
    def.integration = integration;
    return scene_body(&def);
}

static int solve(sb_body *body)
{
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    options.tolerance = REAL(scene_tolerance(1e-11, 64));
    options.max_newton = 60;
    if (CHECK_OK(sb_body_solve_static(body, &options, &info)))
        return 1;
    printf("%s\n", info.error.message);
    return 0;
}

/* Uniform prestretch in a bar held at both ends: rest is balanced, and the ends hold P(G) G^T / det G; every model of
 * the closed forms that takes one, elements that lock and that do not, three sizes. */
static void test_clamped(void)
{
    for (int k = 0; k < VERIFY_MATERIALS; k++)
        for (int e = 0; e < VERIFY_ELEMENTS; e++) {
            const verify_material *law = verify_materials + k;
            const double l[3] = {1.15, 0.98, 1.04}, size = pow(10, 3 * ((k + e) % 3) - 3);
            sb_material plain = law->make(REAL(1e4), REAL(0.3), 1000);
            double stress[3], area = 0.6 * 0.5 * size * size, wanted;
            sb_mesh mesh;
            sb_body *body;
            sb_vec3 force = sb_v3(0, 0, 0);
            if (!sb_material_is_hyperelastic(plain.model) || verify_elements[e].single_rotation)
                continue;
            law->principal(verify_constants_of(1e4, 0.3), l, stress);
            wanted = stress[0] * l[0] / (l[0] * l[1] * l[2]) * area;
            mesh = scene_box(verify_elements[e].type, 3, 2, 2,
                             sb_v3(REAL(2 * size), REAL(0.6 * size), REAL(0.5 * size)), 0.2);
            body = strained_body(&mesh, sb_material_with_prestretch(plain, diagonal(l[0], l[1], l[2])),
                                 verify_elements[e].integration);
            scene_fix_boundary(body, &mesh);
            solve(body);
            CHECK_NEAR(scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count), 0,
                       scene_tolerance(1e-10, 1e4) * size);
            for (int i = 0; i < mesh.node_count; i++)
                if (mesh.nodes[i].x > REAL(1.999 * size))
                    force = sb_v3_add(force, sb_body_reactions(body)[i]);
            /* edges feel the sides, too, whose share is not along x as the stress is diagonal */
            CHECK_NEAR(force.x, wanted, scene_tolerance(1e-9, 1e4) * fabs(wanted));
            sb_body_destroy(body);
            sb_mesh_free(&mesh);
        }
}

/* A body without supports beyond rigid motion relaxes to F = G^-1, where nothing has stress. */
static void test_relaxes(void)
{
    for (int k = 0; k < 8; k++) {
        const double l[3] = {1.1, 0.95, 1.05};
        sb_mesh mesh = scene_box(k % 2 ? SB_TET10 : SB_HEX8, 3, 2, 2, sb_v3(2, REAL(0.6), REAL(0.5)), 0.2);
        sb_material plain = hyperelastic(k);
        sb_body *body =
            strained_body(&mesh, sb_material_with_prestretch(plain, diagonal(l[0], l[1], l[2])), SB_INTEGRATION_AUTO);
        sb_energy energy = {1, 1, 1};
        scene_fix_plane(body, &mesh, 0, 0, SB_X);
        scene_fix_plane(body, &mesh, 1, 0, SB_Y);
        scene_fix_plane(body, &mesh, 2, 0, SB_Z);
        solve(body);
        for (int i = 0; i < mesh.node_count; i++) {
            sb_vec3 x = mesh.nodes[i], at = sb_body_positions(body)[i];
            CHECK_NEAR(at.x, (double)x.x / l[0], scene_tolerance(1e-9, 1e4));
            CHECK_NEAR(at.y, (double)x.y / l[1], scene_tolerance(1e-9, 1e4));
            CHECK_NEAR(at.z, (double)x.z / l[2], scene_tolerance(1e-9, 1e4));
        }
        CHECK_OK(sb_body_energy(body, &energy));
        CHECK_NEAR(energy.elastic, 0, scene_tolerance(1e-12, 1e3) * 1e4);
        CHECK_NEAR(sb_v3_norm(scene_sum(sb_body_reactions(body), mesh.node_count)), 0,
                   scene_tolerance(1e-7, 1e5) * 1e3);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* A bar of two regions, one of which is strained, its ends held and its sides free to slide: St. Venant-Kirchhoff with
 * nu 0 carries one force throughout. */
static double svk_force(double stretch, double g)
{
    return 1e4 * ((stretch * g) * (stretch * g) - 1) / 2 * stretch * g;
}

static void test_regions(void)
{
    const double g = 1.12;
    double low = 0.8, high = 1.2;
    int regions[64];
    sb_mesh mesh = scene_box(SB_HEX8, 4, 1, 1, sb_v3(2, 1, 1), 0);
    sb_body_def def = sb_default_body_def();
    sb_material materials[2];
    sb_body *body;
    sb_error error;
    sb_vec3 force = sb_v3(0, 0, 0);
    for (int e = 0; e < mesh.element_count && e < 64; e++) {
        double x = 0;
        for (int a = 0; a < 8; a++)
            x += (double)mesh.nodes[mesh.elements[8 * e + a]].x / 8;
        regions[e] = x > 1 ? 7 : 3;
    }
    sb_mesh copy = mesh;
    copy.regions = regions;
    materials[0] = sb_material_svk(REAL(1e4), 0, 1000);
    materials[1] = sb_material_with_prestretch(materials[0], diagonal(g, 1, 1));
    def.mesh = &copy;
    def.material = materials[0];
    body = scene_body(&def);
    if (!CHECK_OK(sb_body_set_region_material(body, 7, materials + 1, &error)))
        return;
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    scene_fix_plane(body, &mesh, 0, 2, SB_XYZ);
    solve(body);
    for (int k = 0; k < 80; k++) { /* stretch of the strained half; the other has 2 - it */
        double middle = (low + high) / 2;
        if (svk_force(middle, g) > svk_force(2 - middle, 1))
            high = middle;
        else
            low = middle;
    }
    for (int i = 0; i < mesh.node_count; i++) {
        double x = (double)mesh.nodes[i].x, at = x < 1 ? x * (2 - low) : 2 - (2 - x) * low;
        CHECK_NEAR(sb_body_positions(body)[i].x, at, scene_tolerance(1e-9, 1e4));
        if (x > 1.99)
            force = sb_v3_add(force, sb_body_reactions(body)[i]);
    }
    CHECK_NEAR(force.x, svk_force(low, g), scene_tolerance(1e-8, 1e4) * 1e3);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* A state and a recording carry it to a body that knows nothing of it; an old state takes it away. */
static void test_state(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(1, REAL(0.6), REAL(0.5)), 0.2);
    sb_material plain = sb_material_stable_neo_hookean(REAL(2e4), REAL(0.3), 1000), strained;
    sb_body *body = strained_body(&mesh, plain, SB_INTEGRATION_AUTO);
    sb_body *other = strained_body(&mesh, plain, SB_INTEGRATION_AUTO);
    sb_recording *recording = NULL;
    sb_recording_report report;
    sb_error error;
    size_t sizes[2];
    void *states[2];
    uint64_t hashes[2];
    strained = sb_material_with_prestretch(plain, diagonal(1.1, 1.05, 0.97));
    CHECK_OK(sb_recording_start(body, 1, NULL, &recording, &error));
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    sizes[0] = sb_body_state_size(body), states[0] = malloc(sizes[0]);
    CHECK_OK(sb_body_state_save(body, states[0], sizes[0]));
    hashes[0] = sb_body_state_hash(body);
    CHECK_OK(sb_body_set_material(body, &strained, &error));
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    CHECK(sb_v3_norm(sb_body_velocities(body)[mesh.node_count - 1]) > 0);
    sizes[1] = sb_body_state_size(body), states[1] = malloc(sizes[1]);
    CHECK_OK(sb_body_state_save(body, states[1], sizes[1]));
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    hashes[1] = sb_body_state_hash(body);
    CHECK_OK(sb_body_state_load(other, states[1], sizes[1], &error));
    CHECK_OK(sb_body_step(other, REAL(0.01), NULL));
    CHECK(sb_body_state_hash(other) == hashes[1]);
    CHECK_OK(sb_body_state_load(other, states[0], sizes[0], &error));
    CHECK(sb_body_state_hash(other) == hashes[0]);
    sb_recording_stop(recording);
    if (!CHECK_OK(sb_recording_replay(recording, other, &report)))
        printf("%s\n", report.error.message);
    CHECK(sb_body_state_hash(other) == hashes[1]);
    sb_recording_destroy(recording);
    free(states[0]), free(states[1]);
    sb_body_destroy(body);
    sb_body_destroy(other);
    sb_mesh_free(&mesh);
}

/* Holds the nodes where the image begins. */
static sb_result dress(void *user, sb_body *body, sb_real share, sb_error *error)
{
    const sb_mesh *image = (const sb_mesh *)user;
    sb_result result = SB_OK;
    (void)share;
    for (int i = 0; i < image->node_count && result == SB_OK; i++)
        if (image->nodes[i].x < REAL(1e-6))
            result = sb_body_hold(body, &i, 1, SB_XYZ, error);
    return result;
}

/* The rest shape of a strained organ: its forward solve returns to the image. */
static void test_unload(void)
{
    sb_mesh mesh = scene_box(SB_TET10, 3, 1, 1, sb_v3(1, REAL(0.4), REAL(0.4)), 0), unloaded = mesh;
    sb_vec3 *rest = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof *rest);
    sb_unload_def def = sb_default_unload_def();
    sb_error error;
    def.body.mesh = &mesh;
    def.body.material =
        sb_material_with_prestretch(sb_material_neo_hookean(REAL(1e4), REAL(0.4), 1000), diagonal(1.05, 0.98, 1));
    def.body.gravity = sb_v3(0, 0, REAL(-0.5));
    def.dress = dress;
    def.user = &mesh;
    if (!CHECK_OK(sb_body_unload(&def, rest, NULL, NULL, &error))) {
        printf("%s\n", error.message);
    } else {
        sb_body *body;
        unloaded.nodes = rest;
        body = strained_body(&unloaded, def.body.material, SB_INTEGRATION_AUTO);
        for (int i = 0; i < mesh.node_count; i++)
            if (mesh.nodes[i].x < REAL(1e-6))
                CHECK_OK(sb_body_place(body, &i, 1, SB_XYZ, mesh.nodes + i, NULL));
        CHECK_OK(sb_body_set_gravity(body, def.body.gravity));
        solve(body);
        CHECK(scene_distance(rest, mesh.nodes, mesh.node_count) > 0.03);
        CHECK_NEAR(scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count), 0, scene_tolerance(2e-6, 1e3));
        sb_body_destroy(body);
    }
    free(rest);
    sb_mesh_free(&mesh);
}

static void test_errors(void)
{
    sb_material m = sb_material_neo_hookean(REAL(1e4), REAL(0.3), 1000), set;
    sb_mat3 g = diagonal(1, 1, -1);
    sb_error error;
    set = sb_material_with_prestretch(m, g);
    CHECK_RESULT(sb_material_check(&set, &error), SB_ERROR_MATERIAL);
    set = sb_material_with_prestretch(m, sb_m3_zero());
    CHECK_RESULT(sb_material_check(&set, &error), SB_ERROR_MATERIAL);
    g.m[2][2] = REAL(NAN);
    check_bad_numbers();
    set = sb_material_with_prestretch(m, g);
    CHECK_RESULT(sb_material_check(&set, &error), SB_ERROR_NOT_FINITE);
    set = sb_material_with_prestretch(sb_material_corotated(REAL(1e4), REAL(0.3), 1000), diagonal(1, 1, 2));
    CHECK_RESULT(sb_material_check(&set, &error), SB_ERROR_MATERIAL);
    set = sb_material_with_prestretch(set, sb_m3_identity());
    CHECK_OK(sb_material_check(&set, &error));
    set = sb_material_with_prestretch(m, sb_m3_identity());
    CHECK(memcmp(&set, &m, sizeof m) == 0);
}

CHECK_SUITE(prestretch, {"derivatives", test_derivatives}, {"clamped", test_clamped}, {"relaxes", test_relaxes},
            {"regions", test_regions}, {"states and recordings", test_state}, {"unload", test_unload},
            {"errors", test_errors});
