/* The same bits everywhere: hashes of short scenes, recorded once. They must hold for every compiler, optimisation
 * level and number of threads; when a change of the mathematics moves them, print them anew with GOLDEN=1. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

typedef struct golden_scene {
    const char *name;
    sb_element_type type;
    int neo_hookean;
    sb_integrator integrator;
    unsigned long long expected; /* of double */
} golden_scene;

static const golden_scene scenes[] = {
    {"tet4 corotated Euler", SB_TET4, 0, SB_EULER, 0x4eafd2619621ea59ULL},
    {"tet10 corotated Newmark", SB_TET10, 0, SB_NEWMARK, 0x1c55f3928a0419f0ULL},
    {"hex8 corotated Euler", SB_HEX8, 0, SB_EULER, 0xd263b21e0fb8bab1ULL},
    {"tet4 neo-Hookean Newmark", SB_TET4, 1, SB_NEWMARK, 0x53b0364d661af297ULL},
    {"tet10 neo-Hookean Euler", SB_TET10, 1, SB_EULER, 0x1ed7626bc0203a9cULL},
};

static void test_golden(void)
{
    sb_jobs jobs;
    memset(&jobs, 0, sizeof jobs);
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("golden hashes are of double");
        return;
    }
    for (size_t i = 0; i < sizeof scenes / sizeof scenes[0]; i++) {
        sb_material material = scenes[i].neo_hookean ? sb_material_neo_hookean(REAL(2e4), REAL(0.4), REAL(1000))
                                                     : sb_material_corotated(REAL(2e4), REAL(0.4), REAL(1000));
        unsigned long long hash = scene_play(scenes[i].type, material, scenes[i].integrator, 12, jobs);
        if (getenv("GOLDEN"))
            printf("  %s 0x%016llxULL\n", scenes[i].name, hash);
        if (!CHECK(hash == scenes[i].expected))
            printf("  %s: 0x%016llx\n", scenes[i].name, hash);
    }
}

/* ---- a body that is cut ------------------------------------------------------------------------------------------ */

/* A plane through two thirds of a beam that sags, and a blade that goes into it frame by frame; lattice: intervals. */
static unsigned long long play_cut(int lattice)
{
    sb_mesh mesh = scene_box(SB_TET4, 8, 3, 3, sb_v3(REAL(0.2), REAL(0.06), REAL(0.06)), 0.1);
    sb_body_def def = sb_default_body_def();
    sb_cut_def cut_def = sb_default_cut_def();
    const sb_vec3 plane[3] = {
        {REAL(0.07), REAL(-0.1), REAL(0.02)}, {REAL(0.07), REAL(0.2), REAL(0.02)}, {REAL(0.08), REAL(0.05), REAL(0.3)}};
    unsigned long long hash;
    size_t nodes;
    sb_cut *cut = NULL;
    int stroke = 0;
    def.mesh = &mesh;
    def.material = sb_material_corotated(REAL(2e4), REAL(0.4), REAL(1000));
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.slack = 4;
    cut_def.body = scene_body(&def);
    cut_def.lattice = lattice;
    scene_fix_plane(cut_def.body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_cut_create(&cut_def, &cut, NULL));
    for (int frame = 0; frame < 12; frame++) {
        const sb_real depth = REAL(0.07) - REAL(0.005) * REAL(frame), bent = REAL(0.13) + REAL(0.001) * REAL(frame);
        const sb_vec3 edge[2] = {{bent, REAL(-0.1), depth}, {bent, REAL(0.2), depth + REAL(0.004)}};
        if (frame == 2)
            CHECK_OK(sb_cut_triangles(cut, plane, 1, NULL, NULL));
        if (frame == 4)
            CHECK_OK(sb_cut_begin(cut, edge, 2, &stroke, NULL));
        if (frame > 4)
            CHECK_OK(sb_cut_move(cut, stroke, edge, NULL, NULL));
        CHECK_OK(sb_body_step(cut_def.body, REAL(0.01), NULL));
    }
    CHECK(sb_body_node_count(cut_def.body) > mesh.node_count);
    nodes = (size_t)sb_body_node_count(cut_def.body);
    hash = scene_hash(sb_body_displacements(cut_def.body), nodes * sizeof(sb_vec3)) ^
           scene_hash(sb_body_velocities(cut_def.body), nodes * sizeof(sb_vec3));
    sb_cut_destroy(cut);
    sb_body_destroy(cut_def.body);
    sb_mesh_free(&mesh);
    return hash;
}

static void test_golden_cut(void)
{
    static const struct {
        int lattice;
        unsigned long long expected; /* of double */
    } cuts[] = {{1, 0x81e3344b30554a79ULL}, {2, 0xb2b2fd80e0e67bfaULL}, {4, 0x2488d17e5f78d3a2ULL}};
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("golden hashes are of double");
        return;
    }
    for (size_t i = 0; i < sizeof cuts / sizeof cuts[0]; i++) {
        unsigned long long hash = play_cut(cuts[i].lattice);
        if (getenv("GOLDEN"))
            printf("  cut, lattice %d 0x%016llxULL\n", cuts[i].lattice, hash);
        if (!CHECK(hash == cuts[i].expected))
            printf("  cut, lattice %d: 0x%016llx\n", cuts[i].lattice, hash);
    }
}

/* ---- tools and organs that touch ----------------------------------------------------------------------------------
 */

static unsigned long long force_hash(const sb_contact *contact, int tool)
{
    sb_wrench wrench = {{0, 0, 0}, {0, 0, 0}};
    CHECK_OK(sb_contact_wrench(contact, tool, &wrench));
    CHECK(sb_v3_norm(wrench.force) > 0);
    return scene_hash(&wrench, sizeof wrench);
}

/* A block falls on another, which a chain presses from the side and a box on a spring from above. */
static unsigned long long play_touch(sb_element_type type)
{
    const sb_vec3 chain[3] = {{0, REAL(-0.02), 0}, {0, 0, REAL(0.001)}, {0, REAL(0.02), 0}};
    const int cells = type == SB_TET10 ? 2 : 3;
    sb_mesh mesh = scene_box(type, cells + 1, cells, cells, sb_v3(REAL(0.06), REAL(0.04), REAL(0.03)), 0.1);
    sb_mesh upper = scene_box(type, cells, cells, cells, sb_v3(REAL(0.025), REAL(0.03), REAL(0.02)), 0.1);
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact_def = sb_default_contact_def();
    sb_tool_def tools[2];
    sb_contact *contact = NULL;
    unsigned long long hash;
    size_t nodes;
    int numbers[2];
    for (int i = 0; i < upper.node_count; i++)
        upper.nodes[i] = sb_v3_add(upper.nodes[i], sb_v3(REAL(0.003), REAL(0.005), REAL(0.0304)));
    CHECK_OK(sb_mesh_append(&mesh, &upper, NULL));
    sb_mesh_free(&upper);
    def.mesh = &mesh;
    def.material = sb_material_corotated(REAL(1e4), REAL(0.4), REAL(1000));
    def.damping_stiffness = REAL(0.01);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    contact_def.body = scene_body(&def);
    contact_def.pairs = SB_CONTACT_ORGANS;
    contact_def.pair_friction = REAL(0.4);
    scene_fix_plane(contact_def.body, &mesh, 2, 0, SB_XYZ);
    CHECK_OK(sb_contact_create(&contact_def, &contact, NULL));
    for (int t = 0; t < 2; t++)
        tools[t] = sb_default_tool_def();
    tools[0].shape = SB_TOOL_CAPSULES;
    tools[0].points = chain;
    tools[0].point_count = 3;
    tools[0].radius = REAL(0.006);
    tools[0].friction = REAL(0.3);
    tools[0].pose.position = sb_v3(REAL(-0.0065), REAL(0.02), REAL(0.02));
    tools[1].shape = SB_TOOL_BOX;
    tools[1].half = sb_v3(REAL(0.008), REAL(0.01), REAL(0.008));
    tools[1].radius = REAL(0.004);
    tools[1].coupling_stiffness = REAL(200);
    tools[1].coupling_turning = REAL(0.02);
    tools[1].pose.position = sb_v3(REAL(0.05), REAL(0.02), REAL(0.0385));
    for (int t = 0; t < 2; t++)
        CHECK_OK(sb_contact_add_tool(contact, tools + t, numbers + t, NULL));
    for (int i = 1; i <= 20; i++) {
        sb_pose poses[2];
        poses[0] = tools[0].pose, poses[1] = tools[1].pose;
        poses[0].position.x += REAL(2e-4) * REAL(i);
        poses[1].position.z -= REAL(2e-4) * REAL(i);
        poses[1].position.y += REAL(1e-4) * REAL(i);
        for (int t = 0; t < 2; t++)
            CHECK_OK(sb_contact_move_tool(contact, numbers[t], poses + t));
        CHECK_OK(sb_body_step(contact_def.body, REAL(0.01), NULL));
    }
    CHECK(sb_contact_get_info(contact).touching > 30);
    nodes = (size_t)sb_body_node_count(contact_def.body);
    hash = scene_hash(sb_body_displacements(contact_def.body), nodes * sizeof(sb_vec3)) ^
           scene_hash(sb_body_velocities(contact_def.body), nodes * sizeof(sb_vec3)) ^ force_hash(contact, numbers[0]) ^
           force_hash(contact, numbers[1]);
    sb_contact_destroy(contact);
    sb_body_destroy(contact_def.body);
    sb_mesh_free(&mesh);
    return hash;
}

static void test_golden_touch(void)
{
    static const struct {
        sb_element_type type;
        unsigned long long expected; /* of double */
    } touches[] = {
        {SB_TET4, 0x81cb281b3cd4282bULL}, {SB_TET10, 0xdb579638d03e8a38ULL}, {SB_HEX8, 0x5998387f861aab87ULL}};
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("golden hashes are of double");
        return;
    }
    for (size_t i = 0; i < sizeof touches / sizeof touches[0]; i++) {
        unsigned long long hash = play_touch(touches[i].type);
        if (getenv("GOLDEN"))
            printf("  touch, %s 0x%016llxULL\n", sb_element_name(touches[i].type), hash);
        if (!CHECK(hash == touches[i].expected))
            printf("  touch, %s: 0x%016llx\n", sb_element_name(touches[i].type), hash);
    }
}

CHECK_SUITE(golden, {"golden scenes", test_golden}, {"golden cuts", test_golden_cut},
            {"golden touch", test_golden_touch});
