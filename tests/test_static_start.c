/* test_static_start: static solves from rotations find what others find, in fewer iterations where bodies bend. */
#include "random_case.h"

static int solve_from(sb_body *body, sb_start start, double tolerance)
{
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    options.start = start;
    options.tolerance = REAL(tolerance);
    if (!CHECK_OK(sb_body_solve_static(body, &options, &info)))
        printf("%s\n", info.error.message);
    return info.newton_iterations;
}

static double farthest(const sb_body *a, const sb_body *b)
{
    double most = 0, size = 0;
    for (int i = 0; i < sb_body_node_count(a); i++) {
        sb_vec3 u = sb_body_displacements(a)[i], v = sb_body_displacements(b)[i];
        most = fmax(most, (double)sb_v3_norm(sb_v3_sub(u, v)));
        size = fmax(size, (double)sb_v3_norm(u));
    }
    return most / size;
}

static sb_material some_material(int model, double young, double poisson)
{
    switch (model) {
    case 0: return sb_material_corotated(REAL(young), REAL(poisson), 1000);
    case 1: return sb_material_svk(REAL(young), REAL(poisson), 1000);
    case 2: return sb_material_stable_neo_hookean(REAL(young), REAL(poisson), 1000);
    case 3: {
        const sb_real g = REAL(0.5), tau = 2; /* of twice the modulus, half of which relaxes */
        return sb_material_with_prony(sb_material_neo_hookean(REAL(2 * young), REAL(poisson), 1000), &g, &tau, 1);
    }
    default: return sb_material_mooney_rivlin(REAL(young / 8), REAL(young / 24), REAL(6 / young), 1000);
    }
}

static sb_body *bending_beam(sb_mesh *mesh, sb_element_type type, sb_material material, sb_vec3 gravity,
                             const sb_allocator *allocator)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    *mesh = scene_box(type, 10, 2, 2, sb_v3(REAL(0.1), REAL(0.02), REAL(0.02)), 0.15);
    def.mesh = mesh;
    def.material = material;
    def.gravity = gravity;
    if (allocator)
        def.allocator = *allocator;
    body = scene_body(&def);
    scene_fix_plane(body, mesh, 0, 0, SB_XYZ);
    return body;
}

/* Beams of all kinds under weights from nothing to far too much, in any direction. */
static void test_same_answers(void)
{
    static const sb_element_type types[3] = {SB_TET4, SB_TET10, SB_HEX8};
    unsigned long long seed = 41;
    int saved = 0, needed = 0;
    for (int k = 0; k < (check_quick() ? 5 : 10); k++) {
        sb_vec3 gravity = sb_v3_scale(REAL(random_scale(&seed, 0.02, 0.8)), random_direction(&seed));
        sb_mesh mesh[2];
        sb_body *bodies[2];
        int iterations[2];
        for (int i = 0; i < 2; i++) {
            sb_material material = some_material(k % 5, 5e3, 0.4);
            bodies[i] = bending_beam(&mesh[i], types[k % 3], material, gravity, NULL);
            iterations[i] =
                solve_from(bodies[i], i ? SB_START_PRESENT : SB_START_ROTATIONS, scene_tolerance(1e-9, 1e3));
        }
        CHECK(farthest(bodies[0], bodies[1]) < scene_tolerance(1e-6, 3e4));
        CHECK(iterations[0] <= iterations[1] + 1);
        saved += iterations[1] - iterations[0];
        needed += iterations[1];
        for (int i = 0; i < 2; i++) {
            sb_body_destroy(bodies[i]);
            sb_mesh_free(&mesh[i]);
        }
    }
    printf("  beams from rotations: %d iterations less of %d\n", saved, needed);
    CHECK(saved > 0);
}

/* Of the thing it is made for: a soft beam that bends by its length's third. */
static void test_fewer_iterations(void)
{
    for (int model = 0; model < 5; model++) {
        sb_mesh mesh[2];
        sb_body *bodies[2];
        int iterations[2];
        for (int i = 0; i < 2; i++) {
            bodies[i] = bending_beam(&mesh[i], SB_HEX8, some_material(model, 5e3, 0.3), sb_v3(0, 0, REAL(-0.3)), NULL);
            iterations[i] = solve_from(bodies[i], i ? SB_START_PRESENT : SB_START_AUTO, SB_REAL_IS_FLOAT ? 1e-4 : 1e-6);
        }
        printf("  bending, model %d: %d in place of %d systems\n", model, iterations[0], iterations[1]);
        CHECK(iterations[0] < iterations[1]);
        for (int i = 0; i < 2; i++) {
            sb_body_destroy(bodies[i]);
            sb_mesh_free(&mesh[i]);
        }
    }
}

/* From a shape of its own, with supports that move and a constraint. */
static void test_moving_supports(void)
{
    const sb_constraint_term terms[2] = {{40, 1, 1}, {50, 1, -1}};
    sb_mesh mesh[2];
    sb_body *bodies[2];
    for (int i = 0; i < 2; i++) {
        sb_start start = i ? SB_START_PRESENT : SB_START_ROTATIONS;
        bodies[i] = bending_beam(&mesh[i], SB_HEX8, some_material(2, 5e3, 0.4), sb_v3(0, 0, REAL(-0.2)), NULL);
        CHECK_OK(sb_body_add_constraint(bodies[i], terms, 2, REAL(0.001), NULL, NULL));
        solve_from(bodies[i], start, scene_tolerance(1e-9, 1e3));
        for (int n = 0; n < mesh[i].node_count; n++) {
            sb_vec3 way = sb_v3(0, REAL(0.02), REAL(0.04));
            if (mesh[i].nodes[n].x > REAL(0.0999))
                CHECK_OK(sb_body_prescribe(bodies[i], &n, 1, SB_XYZ, &way, 1));
        }
        solve_from(bodies[i], start, scene_tolerance(1e-9, 1e3));
    }
    CHECK(farthest(bodies[0], bodies[1]) < scene_tolerance(1e-6, 3e4));
    for (int i = 0; i < 2; i++) {
        sb_body_destroy(bodies[i]);
        sb_mesh_free(&mesh[i]);
    }
}

/* Recordings replay starts of all kinds to the last bit; a kind that is none is refused. */
static void test_recorded_starts(void)
{
    for (int start = SB_START_AUTO; start <= SB_START_ROTATIONS; start++) {
        sb_mesh mesh, same;
        sb_body *body = bending_beam(&mesh, SB_HEX8, some_material(2, 5e3, 0.3), sb_v3(0, 0, REAL(-0.3)), NULL), *again;
        sb_recording *recording = NULL;
        sb_static_options options = sb_default_static_options();
        const int below = -1;
        again = bending_beam(&same, SB_HEX8, some_material(2, 5e3, 0.3), sb_v3(0, 0, REAL(-0.3)), NULL);
        CHECK_OK(sb_recording_start(body, 0, NULL, &recording, NULL));
        solve_from(body, (sb_start)start, scene_tolerance(1e-6, 1e3));
        CHECK_OK(sb_recording_replay(recording, again, NULL));
        CHECK(memcmp(sb_body_displacements(body), sb_body_displacements(again),
                     (size_t)mesh.node_count * sizeof(sb_vec3)) == 0);
        options.start = (sb_start)(SB_START_ROTATIONS + 1);
        CHECK(sb_body_solve_static(body, &options, NULL) == SB_ERROR_ARGUMENT);
        memcpy(&options.start, &below, sizeof options.start);
        CHECK(sb_body_solve_static(body, &options, NULL) == SB_ERROR_ARGUMENT);
        sb_recording_destroy(recording);
        sb_body_destroy(again);
        sb_body_destroy(body);
        sb_mesh_free(&same);
        sb_mesh_free(&mesh);
    }
}

/* The start takes no memory: a body's first solve does with what it was made with. */
static void test_no_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    sb_mesh mesh, same;
    sb_body *body = bending_beam(&mesh, SB_HEX8, some_material(1, 5e3, 0.3), sb_v3(0, 0, REAL(-0.3)), &allocator);
    sb_body *other = bending_beam(&same, SB_HEX8, some_material(1, 5e3, 0.3), sb_v3(0, 0, REAL(-0.3)), NULL);
    int calls = memory.calls, with, without, plain;
    without = solve_from(other, SB_START_PRESENT, SB_REAL_IS_FLOAT ? 1e-4 : 1e-6);
    sb_body_reset(other);
    plain = solve_from(other, SB_START_AUTO, SB_REAL_IS_FLOAT ? 1e-4 : 1e-6);
    memory.fail_from = calls + 1;
    with = solve_from(body, SB_START_AUTO, SB_REAL_IS_FLOAT ? 1e-4 : 1e-6);
    CHECK_INT(memory.calls, calls);
    CHECK(with < without);
    CHECK_INT(with, plain);
    memory.fail_from = 0;
    sb_body_destroy(other);
    sb_body_destroy(body);
    CHECK_INT(memory.live, 0);
    sb_mesh_free(&same);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(static_start, {"same answers", test_same_answers}, {"fewer iterations", test_fewer_iterations},
            {"moving supports", test_moving_supports}, {"recorded", test_recorded_starts},
            {"no memory", test_no_memory});
