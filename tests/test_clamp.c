/* Nodes that hang on rigid bodies moved by poses: clamps, bones, tables; and the wrench that they feel. */
#include "check.h"
#include "random_case.h"

/* Nodes below and above a level of x. */
typedef struct two_ends {
    sb_mesh mesh;
    sb_body *body;
    int *low, *high;
    int low_count, high_count;
} two_ends;

static int ends_make(two_ends *e, sb_element_type type, double size, sb_material material, sb_integrator integrator)
{
    sb_body_def def = sb_default_body_def();
    memset(e, 0, sizeof *e);
    e->mesh = scene_box(type, 4, 2, 2, sb_v3(REAL(2 * size), REAL(0.6 * size), REAL(0.5 * size)), 0.2);
    def.mesh = &e->mesh;
    def.material = material;
    def.integrator = integrator;
    e->body = scene_body(&def);
    e->low = (int *)malloc(2 * (size_t)e->mesh.node_count * sizeof(int));
    if (!CHECK(e->body && e->low))
        return 0;
    e->high = e->low + e->mesh.node_count;
    for (int i = 0; i < e->mesh.node_count; i++) {
        if (e->mesh.nodes[i].x < REAL(0.01 * size))
            e->low[e->low_count++] = i;
        if (e->mesh.nodes[i].x > REAL(1.99 * size))
            e->high[e->high_count++] = i;
    }
    return CHECK(e->low_count > 3 && e->high_count > 3);
}

static void ends_free(two_ends *e)
{
    sb_body_destroy(e->body);
    free(e->low);
    sb_mesh_free(&e->mesh);
}

static double tight(void) { return scene_tolerance(1e-10, 64); }

static int solve(sb_body *body)
{
    sb_static_options options = sb_default_static_options();
    options.tolerance = REAL(tight());
    options.load_steps = 4;
    options.max_newton = 60;
    return CHECK_OK(sb_body_solve_static(body, &options, NULL));
}

/* A pose does what prescribed nodes do that were computed from it. */
static void test_prescribed(void)
{
    two_ends a, b;
    const sb_vec3 centre = sb_v3(2, REAL(0.3), REAL(0.2)), position = sb_v3(REAL(2.1), REAL(0.2), REAL(0.25));
    const sb_quat turn = sb_quat_from_rotation_vector(sb_v3(REAL(0.5), REAL(0.2), REAL(-0.3)));
    sb_material material = sb_material_neo_hookean(REAL(1e4), REAL(0.4), 1000);
    if (!ends_make(&a, SB_TET10, 1, material, SB_NEWMARK) || !ends_make(&b, SB_TET10, 1, material, SB_NEWMARK))
        return;
    CHECK_OK(sb_body_fix_nodes(a.body, a.low, a.low_count, SB_XYZ));
    CHECK_OK(sb_body_fix_nodes(b.body, b.low, b.low_count, SB_XYZ));
    CHECK_OK(sb_body_place_rigid(a.body, a.high, a.high_count, centre, position, turn, NULL));
    for (int i = 0; i < b.high_count; i++) {
        sb_vec3 arm = sb_v3_sub(b.mesh.nodes[b.high[i]], centre), to = sb_v3_add(position, sb_quat_rotate(turn, arm));
        CHECK_OK(sb_body_place(b.body, b.high + i, 1, SB_XYZ, &to, NULL));
    }
    if (solve(a.body) && solve(b.body))
        CHECK_NEAR(scene_distance(sb_body_positions(a.body), sb_body_positions(b.body), a.mesh.node_count), 0,
                   scene_tolerance(1e-12, 1e3));
    for (int i = 0; i < 3; i++) {
        CHECK_OK(sb_body_step(a.body, REAL(0.01), NULL));
        CHECK_OK(sb_body_step(b.body, REAL(0.01), NULL));
    }
    CHECK_NEAR(scene_distance(sb_body_positions(a.body), sb_body_positions(b.body), a.mesh.node_count), 0,
               scene_tolerance(1e-7, 1e4));
    ends_free(&a);
    ends_free(&b);
}

/* Where all nodes hang on one body, a quarter turn leaves no energy and no force; at three sizes. */
static void test_rigid_turn(void)
{
    for (int scale = -3; scale <= 3; scale += 3) {
        double size = pow(10, scale);
        two_ends e;
        sb_energy energy = {1, 1, 1};
        sb_vec3 force, torque, centre = sb_v3(REAL(size), 0, 0), position = sb_v3(REAL(-3 * size), REAL(size), 0);
        sb_real least = REAL(1e4 * size * size);
        int *all;
        if (!ends_make(&e, SB_HEX20, size, sb_material_corotated(REAL(1e4), REAL(0.3), 1000), SB_NEWMARK))
            return;
        all = (int *)malloc((size_t)e.mesh.node_count * sizeof(int));
        for (int i = 0; i < e.mesh.node_count && all; i++)
            all[i] = i;
        CHECK_OK(sb_body_place_rigid(e.body, all, e.mesh.node_count, centre, position,
                                     sb_quat_from_rotation_vector(sb_v3(0, REAL(1.5707963267948966), 0)), NULL));
        CHECK_OK(sb_body_solve_static(e.body, NULL, NULL));
        CHECK_OK(sb_body_energy(e.body, &energy));
        CHECK_OK(sb_body_wrench(e.body, all, e.mesh.node_count, position, &force, &torque, NULL));
        CHECK_NEAR(energy.elastic, 0, scene_tolerance(1e-20, 1e3 * (double)SB_EPSILON) * (double)least * size);
        CHECK_NEAR(sb_v3_norm(force), 0, scene_tolerance(1e-12, 1e3) * (double)least);
        CHECK_NEAR(sb_v3_norm(torque), 0, scene_tolerance(1e-12, 1e3) * (double)least * size);
        free(all);
        ends_free(&e);
    }
}

/* Random poses of both ends, materials, elements and sizes: the wrenches of the two clamps and the weight balance about
 * any point. */
static void test_balance(void)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20};
    unsigned long long seed = 77;
    for (int round = 0; round < check_rounds(16); round++) {
        double size = pow(10, 3 * (round % 3) - 3), most = 0;
        const char *name;
        sb_material material = random_material(&seed, &name);
        two_ends e;
        sb_vec3 f[2], t[2], about = sb_v3(REAL(size), REAL(-2 * size), REAL(0.7 * size)), weight, lever;
        sb_vec3 gravity = sb_v3(0, 0, REAL(-9.81));
        if (!ends_make(&e, types[round % 4], size, material, SB_NEWMARK))
            return;
        gravity.z *= REAL(0.02 * (double)sb_material_young(&material) / (9.81 * (double)material.density * size));
        CHECK_OK(sb_body_set_gravity(e.body, gravity));
        for (int k = 0; k < 2; k++) {
            sb_vec3 centre = sb_v3(REAL(2 * size * k), REAL(0.3 * size), REAL(0.2 * size));
            sb_vec3 to = sb_v3_madd(centre, REAL(0.1 * size), random_direction(&seed));
            sb_quat turn = sb_quat_from_rotation_vector(sb_v3_scale(REAL(0.25), random_direction(&seed)));
            CHECK_OK(sb_body_place_rigid(e.body, k ? e.high : e.low, k ? e.high_count : e.low_count, centre, to, turn,
                                         NULL));
        }
        if (!solve(e.body))
            printf("%s, round %d\n", name, round);
        CHECK_OK(sb_body_wrench(e.body, e.low, e.low_count, about, f, t, NULL));
        CHECK_OK(sb_body_wrench(e.body, e.high, e.high_count, about, f + 1, t + 1, NULL));
        weight = scene_sum(sb_body_external_forces(e.body), e.mesh.node_count);
        lever = sb_v3(0, 0, 0);
        for (int i = 0; i < e.mesh.node_count; i++) {
            sb_vec3 at = sb_v3_sub(sb_body_positions(e.body)[i], about);
            lever = sb_v3_add(lever, sb_v3_cross(at, sb_body_external_forces(e.body)[i]));
            most += (double)sb_v3_norm(sb_body_reactions(e.body)[i]);
        }
        CHECK(most > 0);
        CHECK_NEAR(sb_v3_norm(sb_v3_add(sb_v3_add(f[0], f[1]), weight)), 0, scene_tolerance(1e-8, 1e4) * most);
        /* small strain does not see that arms turn: its torques balance about places at rest */
        if (material.model != SB_LINEAR)
            CHECK_NEAR(sb_v3_norm(sb_v3_add(sb_v3_add(t[0], t[1]), lever)), 0,
                       scene_tolerance(1e-8, 1e4) * most * 4 * size);
        ends_free(&e);
    }
}

/* A bar of nu 0 drawn by its clamp: E A d / L, with the torque of its arm. */
static void test_bar(void)
{
    two_ends e;
    sb_vec3 force, torque;
    double wanted = 1e4 * 0.3 * 0.04 / 2;
    if (!ends_make(&e, SB_HEX8, 1, sb_material_linear(REAL(1e4), 0, 1000), SB_NEWMARK))
        return;
    CHECK_OK(sb_body_fix_nodes(e.body, e.low, e.low_count, SB_XYZ));
    CHECK_OK(sb_body_place_rigid(e.body, e.high, e.high_count, sb_v3(0, 0, 0), sb_v3(REAL(0.04), 0, 0),
                                 sb_quat_make(3, 0, 0, 0), NULL)); /* of any length */
    solve(e.body);
    CHECK_OK(sb_body_wrench(e.body, e.high, e.high_count, sb_v3(0, 0, 0), &force, &torque, NULL));
    CHECK_NEAR(force.x, wanted, scene_tolerance(1e-9, 1e4) * wanted);
    CHECK_NEAR(torque.y, 0.25 * wanted, scene_tolerance(1e-9, 1e4) * wanted);
    CHECK_NEAR(torque.z, -0.3 * wanted, scene_tolerance(1e-9, 1e4) * wanted);
    ends_free(&e);
}

/* A recording replays poses, turns that are of no unit length included; a bad pose changes nothing. */
static void test_record(void)
{
    two_ends a, b;
    sb_recording *recording = NULL;
    sb_recording_report report;
    sb_error error;
    uint64_t hash;
    const sb_vec3 centre = sb_v3(2, 0, 0), nowhere = sb_v3(REAL(NAN), 0, 0);
    const int outside[2] = {0, 100000};
    sb_material material = sb_material_corotated(REAL(1e4), REAL(0.4), 1000);
    if (!ends_make(&a, SB_TET4, 1, material, SB_NEWMARK) || !ends_make(&b, SB_TET4, 1, material, SB_NEWMARK))
        return;
    CHECK_OK(sb_recording_start(a.body, 1, NULL, &recording, &error));
    CHECK_OK(sb_body_fix_nodes(a.body, a.low, a.low_count, SB_XYZ));
    for (int k = 0; k < 5; k++) {
        sb_quat turn = sb_quat_make(1, REAL(0.1 * k), REAL(0.03 * k), REAL(-0.02 * k));
        CHECK_OK(sb_body_place_rigid(a.body, a.high, a.high_count, centre, centre, turn, NULL));
        CHECK_OK(sb_body_step(a.body, REAL(0.01), NULL));
    }
    hash = sb_body_state_hash(a.body);
    check_bad_numbers();
    CHECK_RESULT(sb_body_place_rigid(a.body, a.high, 1, nowhere, centre, sb_quat_identity(), &error),
                 SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_body_place_rigid(a.body, a.high, 1, centre, centre, sb_quat_make(0, 0, 0, 0), &error),
                 SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_place_rigid(a.body, outside, 2, centre, centre, sb_quat_identity(), &error), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_wrench(a.body, outside, 2, centre, NULL, NULL, &error), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_wrench(a.body, a.high, 1, nowhere, NULL, NULL, &error), SB_ERROR_NOT_FINITE);
    CHECK(hash == sb_body_state_hash(a.body));
    sb_recording_stop(recording);
    if (!CHECK_OK(sb_recording_replay(recording, b.body, &report)))
        printf("%s\n", report.error.message);
    CHECK_INT(report.steps, 5);
    CHECK(hash == sb_body_state_hash(b.body));
    sb_recording_destroy(recording);
    ends_free(&a);
    ends_free(&b);
}

CHECK_SUITE(clamp, {"a pose and prescribed nodes", test_prescribed}, {"a turn of all nodes", test_rigid_turn},
            {"wrenches balance", test_balance}, {"a bar", test_bar}, {"recording", test_record});
