/* test_contact: tools in contact with a body: closed forms, balances, what cannot pass. */
#include "scene.h"

typedef struct press {
    sb_mesh mesh;
    sb_body *body;
    sb_contact *contact;
    int tool;
} press;

/* A slab of tet4 on its fixed lower side. */
static press press_make(sb_element_type type, int cells, const sb_tool_def *tool)
{
    press p;
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    memset(&p, 0, sizeof p);
    p.mesh = scene_box(type, 2 * cells, 2 * cells, cells, sb_v3(REAL(0.08), REAL(0.08), REAL(0.04)), 0);
    def.mesh = &p.mesh;
    def.material = sb_material_corotated(REAL(5e3), REAL(0.45), 1000);
    def.damping_stiffness = REAL(0.01);
    def.tolerance = sb_max(REAL(1e-10), 100 * SB_EPSILON);
    CHECK_OK(sb_body_create(&def, &p.body, NULL));
    scene_fix_plane(p.body, &p.mesh, 2, 0, SB_X | SB_Y | SB_Z);
    contact.body = p.body;
    contact.max_iterations = 50;
    CHECK_OK(sb_contact_create(&contact, &p.contact, NULL));
    CHECK_OK(sb_contact_add_tool(p.contact, tool, &p.tool, NULL));
    return p;
}

static void press_free(press *p)
{
    sb_contact_destroy(p->contact);
    sb_body_destroy(p->body);
    sb_mesh_free(&p->mesh);
}

/* What the sphere feels, the floor holds: force and torque, with friction, in balance. */
static void test_balance(void)
{
    sb_tool_def tool = sb_default_tool_def();
    sb_pose pose;
    press p;
    sb_wrench wrench = {{0, 0, 0}, {0, 0, 0}};
    sb_vec3 force = {0, 0, 0}, torque = {0, 0, 0};
    tool.radius = REAL(0.012);
    tool.friction = REAL(0.4);
    tool.pose.position = sb_v3(REAL(0.041), REAL(0.038), REAL(0.0525));
    p = press_make(SB_TET4, 5, &tool);
    pose = tool.pose;
    for (int i = 0; i < 80; i++) {
        if (i < 10)
            pose.position = sb_v3_add(pose.position, sb_v3(REAL(0.0002), REAL(0.0001), REAL(-0.0004)));
        CHECK_OK(sb_contact_move_tool(p.contact, p.tool, &pose));
        CHECK_OK(sb_body_step(p.body, REAL(0.02), NULL));
    }
    CHECK_OK(sb_contact_wrench(p.contact, p.tool, &wrench));
    CHECK(wrench.force.z > REAL(0.05));
    for (int i = 0; i < p.mesh.node_count; i++) {
        sb_vec3 r = sb_body_reactions(p.body)[i];
        force = sb_v3_add(force, r);
        torque = sb_v3_add(torque, sb_v3_cross(sb_v3_sub(sb_body_positions(p.body)[i], pose.position), r));
    }
    CHECK_NEAR(sb_v3_norm(sb_v3_sub(force, wrench.force)), 0, scene_tolerance(1e-8, 1e4) * (double)wrench.force.z);
    CHECK_NEAR(sb_v3_norm(sb_v3_sub(torque, wrench.torque)), 0,
               scene_tolerance(1e-8, 1e4) * (double)(wrench.force.z * tool.radius));
    press_free(&p);
}

CHECK_SUITE(contact, {"balance", test_balance});
