/* test_contact_hostile: what no scene should have, and some have: tools that jump, that squeeze, that are made in the
 * body, are too thin or not finite; every material, integrator and constraint under a tool. */
#include "contact_scene.h"

/* ---- what is refused ---- */

static press slab(sb_element_type type, int cells, sb_material material, sb_integrator integrator, int max_newton)
{
    sb_body_def def = sb_default_body_def();
    def.material = material;
    def.integrator = integrator;
    def.max_newton = max_newton;
    def.damping_stiffness = REAL(0.01);
    return press_make(scene_box(type, 2 * cells, 2 * cells, cells, sb_v3(REAL(0.06), REAL(0.06), REAL(0.03)), 0.1), def,
                      sb_default_contact_def());
}

static press plain_slab(void)
{
    press p = slab(SB_TET4, 2, sb_material_corotated(REAL(5e3), REAL(0.45), 1000), SB_EULER, SB_AUTO);
    scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    return p;
}

static void test_refused(void)
{
    const sb_vec3 needle[2] = {{0, 0, REAL(0.06)}, {0, 0, REAL(0.1)}};
    press p = plain_slab();
    sb_tool_def inside = press_sphere(0.008, 0, sb_v3(REAL(0.03), REAL(0.03), REAL(0.03)));
    sb_tool_def thin = press_sphere(0.0005, 0, sb_v3(REAL(0.03), REAL(0.03), 0));
    sb_tool_def sphere = press_sphere(0.008, 0, sb_v3(REAL(0.03), REAL(0.03), REAL(0.05)));
    sb_pose pose = sphere.pose;
    sb_error error;
    uint64_t hash;
    int tool = -1;
    check_bad_numbers();
    CHECK_RESULT(sb_contact_add_tool(p.contact, &inside, &tool, &error), SB_ERROR_ARGUMENT);
    CHECK(error.element >= 0 && error.element < p.mesh.element_count);
    thin.shape = SB_TOOL_CAPSULES;
    thin.points = needle;
    thin.point_count = 2;
    CHECK_RESULT(sb_contact_add_tool(p.contact, &thin, &tool, &error), SB_ERROR_UNSUPPORTED);
    CHECK(strstr(error.message, "needle.h") != NULL);
    CHECK_INT(tool, -1);
    tool = press_add(&p, &sphere);
    hash = sb_body_state_hash(p.body);
    pose.position.x = REAL(NAN);
    CHECK_RESULT(sb_contact_move_tool(p.contact, tool, &pose), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_contact_place_tool(p.contact, tool, &pose, &error), SB_ERROR_NOT_FINITE);
    pose = sphere.pose;
    pose.rotation = sb_quat_make(0, 0, 0, 0);
    CHECK(sb_contact_move_tool(p.contact, tool, &pose) != SB_OK);
    pose.rotation.w = REAL(INFINITY);
    CHECK_RESULT(sb_contact_move_tool(p.contact, tool, &pose), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_contact_set_friction(p.contact, tool, REAL(NAN)), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_contact_set_friction(p.contact, tool, -1), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_contact_place_tool(p.contact, tool, &inside.pose, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_contact_remove_tool(p.contact, 7), SB_ERROR_INDEX);
    CHECK(sb_body_state_hash(p.body) == hash);
    CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
    press_free(&p);
}

/* ---- tools that jump and squeeze ---- */

static void test_teleported(void)
{
    press p = plain_slab();
    sb_tool_def sphere = press_sphere(0.008, 0.3, sb_v3(REAL(0.03), REAL(0.03), REAL(0.05)));
    sb_tool_def box =
        press_box(sb_v3(REAL(0.02), REAL(0.01), REAL(0.006)), 0.005, 0.3, sb_v3(REAL(0.1), REAL(0.03), REAL(0.05)));
    unsigned long long seed = 5;
    int tools[2], good = 0, steps = 120;
    tools[0] = press_add(&p, &sphere);
    tools[1] = press_add(&p, &box);
    for (int i = 0; i < steps; i++) {
        for (int t = 0; t < 2; t++) {
            double x = check_random_in(&seed, -0.15, 0.15), y = check_random_in(&seed, -0.15, 0.15);
            double z = check_random_in(&seed, -0.05, 0.15), turn = check_random_in(&seed, -3, 3);
            press_move(&p, tools[t], sb_v3(REAL(0.03 + x), REAL(0.03 + y), REAL(z)),
                       sb_quat_from_rotation_vector(sb_v3(REAL(turn), REAL(x), REAL(y))));
        }
        good += press_try_step(&p, 0.01);
    }
    CHECK(good > 9 * steps / 10);
    press_free(&p);
}

static void squeeze(sb_material material, int max_newton)
{
    press p = slab(SB_TET4, 2, material, SB_EULER, max_newton);
    sb_tool_def above =
        press_box(sb_v3(REAL(0.04), REAL(0.04), REAL(0.01)), 0.005, 0.3, sb_v3(REAL(0.03), REAL(0.03), REAL(0.0401)));
    sb_tool_def below =
        press_box(sb_v3(REAL(0.04), REAL(0.04), REAL(0.01)), 0.005, 0.3, sb_v3(REAL(0.03), REAL(0.03), REAL(-0.0101)));
    int a = press_add(&p, &above), b = press_add(&p, &below), good = 0, steps = 80;
    double left;
    sb_pose reached[2];
    for (int i = 1; i <= steps; i++) {
        double gap = 0.03 * (1 - 0.9 * (i < 40 ? i : 40) / 40) + 0.0002;
        press_move(&p, a, sb_v3(REAL(0.03), REAL(0.03), REAL(0.025 + 0.5 * gap)), sb_quat_identity());
        press_move(&p, b, sb_v3(REAL(0.03), REAL(0.03), REAL(0.005 - 0.5 * gap)), sb_quat_identity());
        good += press_try_step(&p, 0.01);
    }
    CHECK_OK(sb_contact_reached(p.contact, a, &reached[0], NULL));
    CHECK_OK(sb_contact_reached(p.contact, b, &reached[1], NULL));
    left = ((double)(reached[0].position.z - reached[1].position.z) - 0.02) / 0.03;
    CHECK_INT(good, steps);
    CHECK_NEAR(left, 0.107, 0.001);
    press_free(&p);
}

static void test_squeezed(void)
{
    squeeze(sb_material_corotated(REAL(5e3), REAL(0.45), 1000), SB_AUTO);
    squeeze(sb_material_stable_neo_hookean(REAL(5e3), REAL(0.45), 1000), SB_AUTO);
    squeeze(sb_material_neo_hookean(REAL(5e3), REAL(0.45), 1000), 1);
}

/* ---- materials, integrators, constraints ---- */

/* A sphere presses 3 mm, slides 6 mm, waits. Returns how many of the steps went well. */
static int press_and_slide(const press *p)
{
    sb_tool_def sphere = press_sphere(0.01, 0.4, sb_v3(REAL(0.025), REAL(0.03), REAL(0.0405)));
    int tool = press_add(p, &sphere), good = 0, steps = 60;
    for (int i = 1; i <= steps; i++) {
        double z = 0.0405 - 0.0003 * (i < 12 ? i : 12), x = 0.025 + 0.0003 * (i < 12 ? 0 : i < 32 ? i - 12 : 20);
        press_move(p, tool, sb_v3(REAL(x), REAL(0.03), REAL(z)), sb_quat_identity());
        good += press_try_step(p, 0.01);
    }
    CHECK(press_wrench(p, tool).force.z > 0);
    return good == steps;
}

static void test_materials(void)
{
    for (int m = 0; m < 7; m += check_quick() ? 2 : 1)
        for (int newton = 1; newton <= 20; newton += 19) {
            sb_material materials[7];
            press p;
            materials[0] = sb_material_linear(REAL(5e3), REAL(0.4), 1000);
            materials[1] = sb_material_corotated(REAL(5e3), REAL(0.4), 1000);
            materials[2] = sb_material_corotated_invertible(REAL(5e3), REAL(0.4), 1000);
            materials[3] = sb_material_svk(REAL(5e3), REAL(0.4), 1000);
            materials[4] = sb_material_neo_hookean(REAL(5e3), REAL(0.4), 1000);
            materials[5] = sb_material_stable_neo_hookean(REAL(5e3), REAL(0.4), 1000);
            materials[6] = sb_material_mooney_rivlin(REAL(600), REAL(200), REAL(1e-4), 1000);
            p = slab(SB_TET4, 2, materials[m], SB_EULER, newton);
            scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
            CHECK(press_and_slide(&p));
            press_free(&p);
        }
}

static void test_integrators(void)
{
    const sb_integrator integrators[] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA};
    for (int i = 0; i < 3; i++)
        for (int newton = 1; newton <= 20; newton += 19) {
            press p = slab(SB_TET4, 2, sb_material_corotated(REAL(5e3), REAL(0.4), 1000), integrators[i], newton);
            scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
            CHECK(press_and_slide(&p));
            press_free(&p);
        }
}

/* Supports in the face that is pressed: what they hold and what the tool feels are in balance. */
static void test_supports(void)
{
    press p = plain_slab();
    sb_vec3 force = {0, 0, 0};
    for (int i = 0; i < p.mesh.node_count; i++)
        if (p.mesh.nodes[i].z > REAL(0.0299) && p.mesh.nodes[i].x < REAL(0.031))
            CHECK_OK(sb_body_fix_nodes(p.body, &i, 1, SB_Z));
    CHECK_OK(sb_body_set_solver(p.body, sb_max(REAL(1e-10), 100 * SB_EPSILON), 2000));
    CHECK(press_and_slide(&p));
    for (int i = 0; i < 250; i++)
        CHECK(press_try_step(&p, 0.05));
    force = sb_v3_sub(scene_sum(sb_body_reactions(p.body), p.mesh.node_count), press_wrench(&p, 0).force);
    CHECK_NEAR(sb_v3_norm(force), 0, scene_tolerance(1e-7, 1e5) * (double)press_wrench(&p, 0).force.z);
    press_free(&p);
}

/* Two blocks that are tied, the upper pressed: the floor holds what the tool feels. */
static void test_tied(void)
{
    sb_mesh upper = scene_box(SB_TET4, 3, 3, 2, sb_v3(REAL(0.06), REAL(0.06), REAL(0.015)), 0);
    sb_mesh lower = scene_box(SB_TET4, 4, 4, 2, sb_v3(REAL(0.06), REAL(0.06), REAL(0.015)), 0);
    sb_body_def def = sb_default_body_def();
    sb_boundary boundary;
    int faces[64][3], face_count = 0, slaves[64], slave_count = 0, below;
    sb_vec3 force;
    press p;
    for (int i = 0; i < upper.node_count; i++)
        upper.nodes[i].z += REAL(0.015);
    below = lower.node_count;
    CHECK_OK(sb_mesh_append(&lower, &upper, NULL));
    sb_mesh_free(&upper);
    CHECK_OK(sb_mesh_boundary(&lower, 0, NULL, &boundary, NULL));
    for (int f = 0; f < boundary.surface.element_count; f++) {
        const int *n = boundary.surface.elements + 3 * f;
        int flat = 1;
        for (int a = 0; a < 3; a++)
            flat = flat && n[a] < below && lower.nodes[n[a]].z > REAL(0.0149);
        if (flat && face_count < 64)
            memcpy(faces[face_count++], n, sizeof faces[0]);
    }
    sb_boundary_free(&boundary);
    for (int i = below; i < lower.node_count; i++)
        if (lower.nodes[i].z < REAL(0.0151))
            slaves[slave_count++] = i;
    def.material = sb_material_corotated(REAL(5e3), REAL(0.4), 1000);
    def.damping_stiffness = REAL(0.01);
    def.tolerance = sb_max(REAL(1e-10), 100 * SB_EPSILON);
    p = press_make(lower, def, sb_default_contact_def());
    scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    CHECK_OK(sb_body_tie_faces(p.body, &faces[0][0], face_count, 3, slaves, slave_count, REAL(1e-4), 0, NULL, NULL));
    CHECK(press_and_slide(&p));
    for (int i = 0; i < 150; i++)
        CHECK(press_try_step(&p, 0.05));
    force = sb_v3_sub(scene_sum(sb_body_reactions(p.body), p.mesh.node_count), press_wrench(&p, 0).force);
    CHECK_NEAR(sb_v3_norm(force), 0, scene_tolerance(1e-7, 1e5) * (double)press_wrench(&p, 0).force.z);
    press_free(&p);
}

/* ---- energy ---- */

/* A cube falls on a plane from 5 mm and comes to rest. Of generalised alpha 0.8 gains a tenth of its energy on the way,
 * and Newmark rings on. */
static void fall(sb_integrator integrator, double radius, int max_newton, int must_rest)
{
    sb_body_def def = sb_default_body_def();
    sb_tool_def plane = press_plane(0.3, sb_v3(0, 0, REAL(-0.005)), 0);
    double start, most, kinetic = 0;
    sb_energy energy;
    press p;
    def.material = sb_material_corotated(REAL(2e4), REAL(0.4), 1000);
    def.integrator = integrator;
    def.spectral_radius = REAL(radius);
    def.max_newton = max_newton;
    def.damping_stiffness = REAL(0.003);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.tolerance = REAL(1e-6);
    p = press_make(scene_box(SB_TET4, 3, 3, 3, sb_v3(REAL(0.03), REAL(0.03), REAL(0.03)), 0), def,
                   sb_default_contact_def());
    press_add(&p, &plane);
    start = most = 0.027 * 9.81 * 0.02;
    for (int i = 0; i < 300; i++) {
        double height = 0, total;
        CHECK(press_try_step(&p, 0.005));
        CHECK_OK(sb_body_energy(p.body, &energy));
        for (int k = 0; k < p.mesh.node_count; k++) /* near enough: no weights */
            height += (double)sb_body_positions(p.body)[k].z / p.mesh.node_count;
        kinetic = (double)energy.kinetic;
        total = kinetic + (double)energy.elastic + 0.027 * 9.81 * (height + 0.005);
        most = fmax(most, total);
    }
    CHECK(most < (must_rest ? 1.001 : 1.2) * start);
    CHECK(!must_rest || kinetic < 1e-9 * start);
    CHECK_NEAR(press_wrench(&p, 0).force.z, -0.027 * 9.81, (must_rest ? 1e-3 : 0.2) * 0.027 * 9.81);
    press_free(&p);
}

static void test_fall(void)
{
    fall(SB_EULER, 0.5, 1, 1);
    fall(SB_EULER, 0.5, 20, 1);
    fall(SB_GENERALISED_ALPHA, 0.5, 20, 1);
    if (check_quick())
        return;
    fall(SB_GENERALISED_ALPHA, 0, 20, 1);
    fall(SB_GENERALISED_ALPHA, 0.8, 20, 0);
    fall(SB_NEWMARK, 0.5, 20, 0);
}

CHECK_SUITE(contact_hostile, {"refused", test_refused}, {"teleported", test_teleported}, {"squeezed", test_squeezed},
            {"materials", test_materials}, {"integrators", test_integrators}, {"supports", test_supports},
            {"tied", test_tied}, {"fall", test_fall});
