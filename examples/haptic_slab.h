/* haptic_slab.h: what the haptic examples touch: a slab of tissue on a table, and a sphere above it on the hand's side.
 * Include it after the implementation of softbody.h. */
#ifndef HAPTIC_SLAB_H
#define HAPTIC_SLAB_H

#include "softbody.h"

static const double slab_radius = 0.012; /* m, of the sphere */

/* 80 x 80 x 40 mm, its upper side a sphere's radius below the origin along axis `up` (0: x, 1: y, 2: z). */
static inline sb_result slab_make_body(double young, int up, sb_body **body, sb_error *error)
{
    const double half = 0.04;
    sb_body_def def = sb_default_body_def();
    sb_vec3 size = sb_v3(up == 0 ? half : 2 * half, up == 1 ? half : 2 * half, up == 2 ? half : 2 * half), low = size;
    sb_mesh mesh;
    sb_result result =
        sb_mesh_beam(SB_TET4, up == 0 ? 4 : 8, up == 1 ? 4 : 8, up == 2 ? 4 : 8, size, NULL, &mesh, error);
    if (result != SB_OK)
        return result;
    low = sb_v3(up == 0 ? -half - slab_radius : -half, up == 1 ? -half - slab_radius : -half,
                up == 2 ? -half - slab_radius : -half);
    for (int i = 0; i < mesh.node_count; i++)
        mesh.nodes[i] = sb_v3_add(mesh.nodes[i], low);
    def.mesh = &mesh;
    def.material = sb_material_corotated(young, 0.45, 1000);
    def.damping_stiffness = 0.01;
    def.gravity = sb_v3(0, 0, 0);
    result = sb_body_create(&def, body, error);
    for (int i = 0; i < mesh.node_count && result == SB_OK; i++) {
        sb_vec3 x = mesh.nodes[i];
        if ((up == 0 ? x.x : up == 1 ? x.y : x.z) < -0.9 * half - slab_radius)
            result = sb_body_hold(*body, &i, 1, SB_XYZ, error);
    }
    sb_mesh_free(&mesh);
    return result;
}

typedef struct slab {
    sb_body *body;
    sb_contact *contact;
    sb_haptic *haptic;
    int tool;
} slab;

/* The sphere, a little above the slab, and the hand at it. def: of the device, without contact and tool. */
static inline sb_result slab_make(slab *s, double young, int up, const sb_haptic_def *device, sb_error *error)
{
    const double above = 0.002;
    sb_contact_def contact = sb_default_contact_def();
    sb_tool_def tool = sb_default_tool_def();
    sb_haptic_def def = *device;
    sb_result result = slab_make_body(young, up, &s->body, error);
    contact.body = s->body;
    tool.radius = slab_radius;
    tool.friction = 0.3;
    tool.pose.position = sb_v3(up == 0 ? above : 0, up == 1 ? above : 0, up == 2 ? above : 0);
    if (result == SB_OK)
        result = sb_contact_create(&contact, &s->contact, error);
    if (result == SB_OK)
        result = sb_contact_add_tool(s->contact, &tool, &s->tool, error);
    def.contact = s->contact;
    def.tool = s->tool;
    if (result == SB_OK)
        result = sb_haptic_create(&def, &s->haptic, error);
    return result;
}

static inline void slab_free(slab *s)
{
    sb_haptic_destroy(s->haptic);
    sb_contact_destroy(s->contact);
    sb_body_destroy(s->body);
}

#endif /* HAPTIC_SLAB_H */
