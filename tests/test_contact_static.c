/* test_contact_static: contact in static solves, and on meshes that change. */
#define SB_SPLIT_BUILD
#include "../src/softbody/contact/contact_private.h"

#include <math.h>

#include "follow_change.h"
#include "scene.h"

typedef struct press {
    sb_mesh mesh;
    sb_body *body;
    sb_contact *contact;
    int tool;
    sb_pose pose;
} press;

static void press_free(press *p)
{
    sb_contact_destroy(p->contact);
    sb_body_destroy(p->body);
    sb_mesh_free(&p->mesh);
}

/* ---- Hertz: a quarter of a block, fine at the corner where a sphere is pressed into its upper side ---- */

static const double side = 0.08, sphere = 0.1, hertz_young = 5e3, hertz_poisson = 0.3;

static sb_real graded(sb_real x) { return x * x / REAL(side); }

static press hertz_make(int cells, sb_real friction)
{
    press p;
    sb_mesh box = scene_box(SB_TET4, cells, cells, cells, sb_v3(REAL(side), REAL(side), REAL(side)), 0);
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    sb_tool_def tool = sb_default_tool_def();
    sb_real edge = REAL(1e-6 * side), end = REAL(side) - edge;
    memset(&p, 0, sizeof p);
    for (int i = 0; i < box.node_count; i++) {
        sb_vec3 *x = box.nodes + i;
        *x = sb_v3(graded(x->x), graded(x->y), REAL(side) - graded(REAL(side) - x->z));
    }
    CHECK_OK(sb_mesh_to_tet10(&box, NULL, &p.mesh, NULL));
    sb_mesh_free(&box);
    def.mesh = &p.mesh;
    def.material = sb_material_linear(REAL(hertz_young), REAL(hertz_poisson), 1000);
    CHECK_OK(sb_body_create(&def, &p.body, NULL));
    for (int i = 0; i < p.mesh.node_count; i++) {
        sb_vec3 x = p.mesh.nodes[i];
        int axes = x.z < edge || x.x > end || x.y > end ? SB_XYZ : (x.x < edge ? SB_X : 0) | (x.y < edge ? SB_Y : 0);
        if (axes)
            CHECK_OK(sb_body_fix_nodes(p.body, &i, 1, axes));
    }
    contact.body = p.body;
    CHECK_OK(sb_contact_create(&contact, &p.contact, NULL));
    tool.radius = REAL(sphere);
    tool.friction = friction;
    tool.pose.position = sb_v3(0, 0, REAL(side + sphere + 1e-5));
    p.pose = tool.pose;
    CHECK_OK(sb_contact_add_tool(p.contact, &tool, &p.tool, NULL));
    return p;
}

/* Force (N) on the sphere at a depth (m), and what the supports hold beside it. */
static double hertz_press(press *p, double depth, double *missing)
{
    sb_wrench wrench = {{0, 0, 0}, {0, 0, 0}};
    double held = 0;
    sb_static_options options = sb_default_static_options();
    options.tolerance = scene_tolerance(1e-6, 1e4) > 1e-6 ? REAL(1e-3) : REAL(1e-6);
    p->pose.position.z = REAL(side + sphere - depth);
    CHECK_OK(sb_contact_move_tool(p->contact, p->tool, &p->pose));
    CHECK_OK(sb_body_solve_static(p->body, &options, NULL));
    CHECK_OK(sb_contact_wrench(p->contact, p->tool, &wrench));
    for (int i = 0; i < p->mesh.node_count; i++)
        held += (double)sb_body_reactions(p->body)[i].z;
    *missing = held - (double)wrench.force.z;
    return (double)wrench.force.z;
}

/* F = 4/3 E/(1 - nu^2) sqrt(R) d^1.5 (1 + 1.04 a/L) of a block that is held at L; a quarter of it here. */
static double hertz_force(double depth)
{
    double radius = sqrt(sphere * depth);
    return 4.0 / 3 * hertz_young / (1 - hertz_poisson * hertz_poisson) * sqrt(sphere) * pow(depth, 1.5) *
           (1 + 1.04 * radius / side) / 4;
}

static void test_hertz(void)
{
    press p = hertz_make(check_quick() ? 6 : 8, 0);
    double missing, half = hertz_press(&p, 0.0005, &missing), whole = hertz_press(&p, 0.001, &missing);
    printf("Hertz: %+.2f %% at 0.5 mm, %+.2f %% at 1 mm\n", 100 * (half / hertz_force(0.0005) - 1),
           100 * (whole / hertz_force(0.001) - 1));
    CHECK_NEAR(whole / hertz_force(0.001), 1, check_quick() ? 0.06 : 0.03);
    CHECK_NEAR(missing / whole, 0, scene_tolerance(1e-6, 1e5));
    CHECK(sb_contact_get_info(p.contact).deepest <= REAL(2e-6)); /* 1e-3 of the depth, and the tool's own curvature */
    press_free(&p);
}

/* A solve that fails leaves tool, memory and body as they were. */
static void test_undo(void)
{
    press p = hertz_make(3, REAL(0.3));
    sb_static_options options = sb_default_static_options();
    sb_pose pose, before;
    double missing;
    uint64_t hash;
    hertz_press(&p, 0.001, &missing);
    hash = sb_body_state_hash(p.body);
    CHECK_OK(sb_contact_reached(p.contact, p.tool, &before, NULL));
    pose = p.pose;
    pose.position.z -= REAL(0.004);
    CHECK_OK(sb_contact_move_tool(p.contact, p.tool, &pose));
    options.max_newton = 2;
    options.tolerance = REAL(1e-12);
    CHECK(sb_body_solve_static(p.body, &options, NULL) != SB_OK);
    CHECK_OK(sb_contact_reached(p.contact, p.tool, &pose, NULL));
    CHECK(pose.position.z == before.position.z);
    CHECK_OK(sb_contact_move_tool(p.contact, p.tool, &p.pose));
    CHECK(sb_body_state_hash(p.body) == hash);
    press_free(&p);
}

/* Tools are no supports. */
static void test_held_by_tools(void)
{
    press p = hertz_make(2, REAL(0.3));
    sb_step_info info;
    for (int i = 0; i < p.mesh.node_count; i++)
        CHECK_OK(sb_body_release_nodes(p.body, &i, 1, SB_XYZ));
    CHECK_RESULT(sb_body_solve_static(p.body, NULL, &info), SB_ERROR_UNCONSTRAINED);
    CHECK(info.error.node >= 0);
    press_free(&p);
}

/* ---- a mesh that changes below a tool ---- */

/* A slab whose mesh may change, with a sphere that is to press it. */
static press changing_press(void)
{
    press p;
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    sb_tool_def tool = sb_default_tool_def();
    memset(&p, 0, sizeof p);
    p.mesh = scene_box(SB_TET4, 6, 6, 3, sb_v3(REAL(0.06), REAL(0.06), REAL(0.03)), 0.1);
    def.mesh = &p.mesh;
    def.material = sb_material_corotated(5000, REAL(0.4), 1000);
    def.slack = REAL(0.2); /* and beyond it: arrays grow */
    def.damping_stiffness = REAL(0.01);
    CHECK_OK(sb_body_create(&def, &p.body, NULL));
    scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    contact.body = p.body;
    contact.max_iterations = 20;
    CHECK_OK(sb_contact_create(&contact, &p.contact, NULL));
    tool.radius = REAL(0.02);
    tool.friction = REAL(0.3);
    tool.pose.position = sb_v3(REAL(0.03), REAL(0.03), REAL(0.0505));
    CHECK_OK(sb_contact_add_tool(p.contact, &tool, &p.tool, NULL));
    tool.pose.position.z = REAL(0.047);
    CHECK_OK(sb_contact_move_tool(p.contact, p.tool, &tool.pose));
    return p;
}

static void test_changes(void)
{
    press p = changing_press();
    unsigned long long seed = 11;
    int changes = 0;
    for (int i = 0; i < 60; i++) {
        follow_op op;
        sb_wrench wrench;
        if (i > 15 && follow_change(p.body, &op, 0, 4, &seed) == SB_OK)
            changes++;
        CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
        CHECK_OK(sb_contact_wrench(p.contact, p.tool, &wrench));
        CHECK(sb_v3_is_finite(wrench.force));
        if (i > 10)
            CHECK(wrench.force.z > REAL(0.2) && wrench.force.z < 2);
    }
    CHECK(changes > 20);
    press_free(&p);
}

/* A state of another mesh makes the body anew: tools press on it all the same. */
static void test_another_mesh(void)
{
    press p = changing_press();
    unsigned long long seed = 12;
    size_t size;
    void *state;
    sb_wrench before, after;
    follow_op op;
    for (int i = 0; i < 20; i++)
        CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
    size = sb_body_state_size(p.body);
    state = malloc(size);
    CHECK_OK(sb_body_state_save(p.body, state, size));
    CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
    CHECK_OK(sb_contact_wrench(p.contact, p.tool, &before));
    for (int i = 0; i < 20; i++)
        follow_change(p.body, &op, 0, 4, &seed);
    CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
    CHECK_OK(sb_body_state_load(p.body, state, size, NULL));
    CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
    CHECK_OK(sb_contact_wrench(p.contact, p.tool, &after));
    CHECK(after.force.z > REAL(0.2));
    CHECK_NEAR(after.force.z, before.force.z, scene_tolerance(1e-9, 1e3));
    free(state);
    press_free(&p);
}

/* A static solve that is refused before it begins gives back what was before it, not what was before an earlier one. */
static void test_refused_after_another(void)
{
    press p = changing_press();
    sb_tool_def far = sb_default_tool_def();
    uint64_t hash;
    far.pose.position = sb_v3(REAL(0.03), REAL(0.03), REAL(0.0495));
    CHECK_OK(sb_contact_move_tool(p.contact, p.tool, &far.pose));
    CHECK_OK(sb_body_solve_static(p.body, NULL, NULL));
    CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
    far.pose.position.z = -3;
    CHECK_OK(sb_contact_move_tool(p.contact, p.tool, &far.pose));
    hash = sb_body_state_hash(p.body);
    CHECK(sb_body_solve_static(p.body, NULL, NULL) != SB_OK);
    CHECK(sb_body_state_hash(p.body) == hash);
    press_free(&p);
}

/* A solve that fails on its way and keeps what it reached: readings are of there, but the system of there is gone. */
static void test_keep_progress(void)
{
    press p = changing_press();
    sb_static_options options = sb_default_static_options();
    const sb_vec3 straight[2] = {{REAL(-0.01), 0, 0}, {REAL(0.01), 0, 0}},
                  bent[2] = {{REAL(-0.01), 0, 0}, {REAL(0.01), 0, REAL(0.004)}};
    sb_tool_def chain = sb_default_tool_def();
    sb_pose goal = chain.pose, reached;
    sb_step_info info;
    sb_wrench wrench;
    sb_real k[6][6], share, held = 0;
    int second;
    chain.shape = SB_TOOL_CAPSULES;
    chain.points = straight;
    chain.point_count = 2;
    chain.radius = REAL(0.004);
    chain.pose.position = sb_v3(REAL(0.03), REAL(0.03), REAL(0.2));
    CHECK_OK(sb_contact_add_tool(p.contact, &chain, &second, NULL));
    CHECK_OK(sb_contact_bend_tool(p.contact, second, bent));
    goal.position = sb_v3(REAL(0.03), REAL(0.03), REAL(0.0005));
    CHECK_OK(sb_contact_move_tool(p.contact, p.tool, &goal));
    options.load_steps = 16;
    options.keep_progress = 1;
    options.max_newton = 4; /* soon too few */
    CHECK(sb_body_solve_static(p.body, &options, &info) != SB_OK);
    CHECK(info.load_steps > 1 && info.load_factor < 1);
    share = info.load_factor;
    CHECK_OK(sb_contact_reached(p.contact, p.tool, &reached, NULL));
    CHECK_NEAR(reached.position.z, 0.0505 - (0.0505 - 0.0005) * (double)share, scene_tolerance(1e-12, 1e5));
    CHECK_NEAR(p.contact->tools[second].chain_reached[1].z, 0.004 * (double)share, scene_tolerance(1e-12, 1e5));
    CHECK_OK(sb_contact_wrench(p.contact, p.tool, &wrench));
    for (int i = 0; i < p.mesh.node_count; i++)
        held += sb_body_reactions(p.body)[i].z;
    CHECK_NEAR(held / wrench.force.z, 1, scene_tolerance(1e-5, 1e4));
    CHECK_RESULT(sb_contact_stiffness(p.contact, p.tool, k), SB_ERROR_STATE);
    CHECK_OK(sb_contact_move_tool(p.contact, p.tool, &reached));
    CHECK_OK(sb_body_solve_static(p.body, NULL, NULL));
    CHECK_OK(sb_contact_stiffness(p.contact, p.tool, k));
    CHECK(k[2][2] < 0);
    press_free(&p);
}

CHECK_SUITE(contact_static, {"Hertz", test_hertz}, {"undo", test_undo}, {"held by tools alone", test_held_by_tools},
            {"changes of the mesh", test_changes}, {"another mesh", test_another_mesh},
            {"refused after another", test_refused_after_another}, {"keeps what it reached", test_keep_progress});
