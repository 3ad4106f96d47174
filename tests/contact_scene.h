/* contact_scene.h: what tests of contact share: a box of a body with a contact, poses, sums. */
#ifndef CONTACT_SCENE_H
#define CONTACT_SCENE_H

#include "scene.h"

typedef struct press {
    sb_mesh mesh;
    sb_body *body;
    sb_contact *contact;
} press;

/* Iterates contact as far as the solves go: for closed forms and balances. */
static inline sb_contact_def press_exact(void)
{
    sb_contact_def def = sb_default_contact_def();
    def.max_iterations = 100;
    return def;
}

/* A body of the mesh (which becomes the press's) with a contact; their defs' mesh and body are set here. */
static inline press press_make(sb_mesh mesh, sb_body_def def, sb_contact_def contact)
{
    press p;
    memset(&p, 0, sizeof p);
    p.mesh = mesh;
    def.mesh = &p.mesh;
    p.body = scene_body(&def);
    contact.body = p.body;
    CHECK_OK(sb_contact_create(&contact, &p.contact, NULL));
    return p;
}

static inline void press_free(press *p)
{
    sb_contact_destroy(p->contact);
    sb_body_destroy(p->body);
    sb_mesh_free(&p->mesh);
}

static inline int press_add(const press *p, const sb_tool_def *def)
{
    int tool = -1;
    sb_error error;
    if (sb_contact_add_tool(p->contact, def, &tool, &error) != SB_OK) {
        printf("%s\n", error.message);
        CHECK(tool >= 0);
    }
    return tool;
}

static inline sb_pose press_pose(sb_vec3 at, sb_quat rotation)
{
    sb_pose pose;
    pose.position = at;
    pose.rotation = rotation;
    return pose;
}

static inline void press_move(const press *p, int tool, sb_vec3 at, sb_quat rotation)
{
    sb_pose pose = press_pose(at, rotation);
    CHECK_OK(sb_contact_move_tool(p->contact, tool, &pose));
}

static inline sb_wrench press_wrench(const press *p, int tool)
{
    sb_wrench wrench = {{0, 0, 0}, {0, 0, 0}};
    CHECK_OK(sb_contact_wrench(p->contact, tool, &wrench));
    return wrench;
}

static inline sb_tool_def press_sphere(double radius, double friction, sb_vec3 at)
{
    sb_tool_def def = sb_default_tool_def();
    def.radius = REAL(radius);
    def.friction = REAL(friction);
    def.pose.position = at;
    return def;
}

static inline sb_tool_def press_box(sb_vec3 half, double radius, double friction, sb_vec3 at)
{
    sb_tool_def def = press_sphere(radius, friction, at);
    def.shape = SB_TOOL_BOX;
    def.half = half;
    return def;
}

/* Turns z to -z. */
static inline sb_quat press_upside_down(void) { return sb_quat_make(0, 1, 0, 0); }

/* All that lies above a height (down 1) or below it. */
static inline sb_tool_def press_plane(double friction, sb_vec3 at, int down)
{
    sb_tool_def def = press_sphere(0, friction, at);
    def.shape = SB_TOOL_PLANE;
    if (down)
        def.pose.rotation = press_upside_down();
    return def;
}

/* Steps that may fail, but leave all as it was then, and finite. Returns 1 when it did not fail. */
static inline int press_try_step(const press *p, double dt)
{
    uint64_t hash = sb_body_state_hash(p->body);
    sb_step_info info;
    sb_result result = sb_body_step(p->body, REAL(dt), &info);
    CHECK(scene_all_finite(sb_body_positions(p->body), p->mesh.node_count));
    CHECK(scene_all_finite(sb_body_velocities(p->body), p->mesh.node_count));
    if (result != SB_OK)
        CHECK(sb_body_state_hash(p->body) == hash && info.error.result == result && info.error.message[0]);
    return result == SB_OK;
}

#endif /* CONTACT_SCENE_H */
