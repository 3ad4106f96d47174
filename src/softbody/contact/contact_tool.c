/* contact_tool: the tools of a contact: made, moved, removed. */
#include <string.h>

#include "contact_private.h"

/* ---- memory ---- */

SBI_API void sbi_contact_free_tool(sb_contact *contact, int tool)
{
    sbi_contact_tool *t = contact->tools + tool;
    sbi_tool_destroy(t->shape);
    sbi_free(&contact->allocator, t->chain_reached);
    memset(t, 0, sizeof *t);
}

/* Chains of the tool at all of its poses. */
static sb_result sbi_contact_take_chains(sb_contact *contact, sbi_contact_tool *tool, const sb_tool_def *def,
                                         sb_error *error)
{
    size_t count = (size_t)sbi_tool_point_count(tool->shape);
    sb_vec3 **chains[] = {&tool->chain_reached, &tool->chain_wanted, &tool->chain_next, &tool->chain_balance,
                          &tool->chain_stage};
    size_t copies = sizeof chains / sizeof *chains;
    sb_vec3 *points;
    if (count == 0)
        return SB_OK;
    points = (sb_vec3 *)sbi_alloc(&contact->allocator, copies * count, sizeof *points);
    if (!points)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a chain of %d points", (int)count);
    for (size_t i = 0; i < copies; i++) {
        *chains[i] = points + i * count;
        memcpy(*chains[i], def->points, count * sizeof *points);
    }
    return SB_OK;
}

/* ---- checks ---- */

/* Of the faces as the mesh is now. */
static sb_result sbi_contact_check_thickness(sb_contact *contact, const sbi_tool *shape, sb_error *error)
{
    int face = 0;
    sb_real thinnest;
    sb_result result = sbi_contact_update_faces(contact, error);
    if (result != SB_OK)
        return result;
    thinnest = sbi_contact_faces_thinnest(contact->faces, &face);
    if (sbi_tool_radius(shape) >= thinnest)
        return SB_OK;
    return sbi_fail_element(error, SB_ERROR_UNSUPPORTED, contact->faces->elements[face],
                            "a tool of radius %g m is too thin for the face of element %d: it needs %g m, or a finer "
                            "surface (a needle is needle.h's)",
                            (double)sbi_tool_radius(shape), contact->faces->elements[face], (double)thinnest);
}

static sb_result sbi_contact_check_depth(sb_contact *contact, const sbi_tool *shape, const sb_vec3 *chain,
                                         const sb_pose *pose, sb_error *error)
{
    int element, face;
    sb_real depth;
    sb_result result = sbi_contact_update_faces(contact, error);
    if (result != SB_OK)
        return result;
    depth = sbi_contact_depth(contact, shape, chain, pose, &element);
    if (depth > (sb_real)0.5 * sbi_tool_inner_radius(shape))
        return sbi_fail_element(error, SB_ERROR_ARGUMENT, element,
                                "the tool lies %g m deep in the body at element %d: more than half its inner radius",
                                (double)depth, element);
    face = sbi_contact_surrounds_tool(contact, shape, chain, pose, &depth);
    if (face < 0)
        return SB_OK;
    return sbi_fail_element(error, SB_ERROR_ARGUMENT, contact->faces->elements[face],
                            "the tool lies inside the body: it is %g m from there to the face of element %d",
                            (double)depth, contact->faces->elements[face]);
}

static sb_result sbi_contact_make_tool(sb_contact *contact, const sb_tool_def *def, sbi_contact_tool *made,
                                       sb_error *error)
{
    sb_result result = sbi_tool_create(def, &contact->allocator, sbi_body_jobs(contact->body), &made->shape, error);
    if (result != SB_OK)
        return result;
    result = sbi_tool_pose_check(&def->pose, "def.pose", &made->reached, error);
    if (result == SB_OK)
        result = sbi_tool_place_check(made->shape, NULL, &made->reached, "def.pose", error);
    if (result == SB_OK)
        result = sbi_contact_check_thickness(contact, made->shape, error);
    if (result == SB_OK)
        result = sbi_contact_take_chains(contact, made, def, error);
    if (result == SB_OK)
        result = sbi_contact_check_depth(contact, made->shape, made->chain_reached, &made->reached, error);
    made->wanted = made->next = made->balance = made->reached;
    made->friction = def->friction;
    made->spring.stiffness = def->coupling_stiffness;
    made->spring.turning = def->coupling_turning;
    made->spring.most = def->max_force;
    made->spring.hand = made->reached;
    if (result == SB_OK && sbi_contact_is_hung(made))
        result = sbi_body_reserve_coupling(contact->body, sbi_contact_body_room(contact), error);
    if (result == SB_OK && !(sbi_contact_reserve_kept(contact) && sbi_body_reserve_touch_kept(contact->body)))
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for what a step that is taken back gives back");
    return result;
}

/* ---- calls ---- */

SB_API sb_result sb_contact_add_tool(sb_contact *contact, const sb_tool_def *def, int *tool, sb_error *error)
{
    int place = 0;
    sb_result result;
    if (!contact || !def || !tool)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a tool needs a contact, a def and a place for its number");
    while (place < contact->max_tools && contact->tools[place].shape)
        place++;
    if (place == contact->max_tools)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the contact has max_tools = %d already", contact->max_tools);
    result = sbi_contact_make_tool(contact, def, contact->tools + place, error);
    if (result != SB_OK)
        sbi_contact_free_tool(contact, place);
    if (result == SB_OK) {
        *tool = place;
        sbi_contact_tell(contact, SBI_CONTACT_ADD, place, NULL, 0);
    }
    return result;
}

static sbi_contact_tool *sbi_contact_find_tool(const sb_contact *contact, int tool)
{
    return tool >= 0 && tool < contact->max_tools && contact->tools[tool].shape ? contact->tools + tool : NULL;
}

/* Contacts of a tool are no more. */
static void sbi_contact_forget(sb_contact *contact, int tool)
{
    int *kept = contact->skin.waiting > 0 ? &contact->skin.waiting : &contact->entry_count, count = 0;
    for (int e = 0; e < *kept; e++)
        if (contact->entries[e].tool != tool)
            contact->entries[count++] = contact->entries[e];
    *kept = count;
    count = 0;
    for (int i = 0; i < contact->pressure_count; i++)
        if (contact->pressures[i].tool != tool)
            contact->pressures[count++] = contact->pressures[i];
    contact->pressure_count = count;
    contact->tools[tool].force = contact->tools[tool].torque = sb_v3(0, 0, 0);
    contact->tools[tool].spring.force = contact->tools[tool].spring.torque = sb_v3(0, 0, 0);
    contact->tools[tool].nearest.known = 0;
    contact->is_solved = 0;
}

SB_API sb_result sb_contact_remove_tool(sb_contact *contact, int tool)
{
    if (!contact)
        return SB_ERROR_ARGUMENT;
    if (!sbi_contact_find_tool(contact, tool))
        return SB_ERROR_INDEX;
    sbi_contact_forget(contact, tool);
    sbi_contact_free_tool(contact, tool);
    sbi_contact_tell(contact, SBI_CONTACT_REMOVE, tool, NULL, 0);
    return SB_OK;
}

SB_API sb_result sb_contact_move_tool(sb_contact *contact, int tool, const sb_pose *pose)
{
    sbi_contact_tool *t;
    sb_pose unit;
    sb_result result;
    if (!contact || !pose)
        return SB_ERROR_ARGUMENT;
    t = sbi_contact_find_tool(contact, tool);
    if (!t)
        return SB_ERROR_INDEX;
    result = sbi_tool_pose_check(pose, "the pose", &unit, NULL);
    if (result == SB_OK)
        result = sbi_tool_place_check(t->shape, t->chain_wanted, &unit, "the pose", NULL);
    if (result != SB_OK)
        return result;
    t->wanted = unit;
    sbi_contact_tell_pose(contact, SBI_CONTACT_MOVE, tool, pose);
    return SB_OK;
}

SB_API sb_result sb_contact_place_tool(sb_contact *contact, int tool, const sb_pose *pose, sb_error *error)
{
    sbi_contact_tool *t;
    sb_pose unit;
    sb_result result;
    if (!contact || !pose)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a tool is placed by a contact and a pose");
    t = sbi_contact_find_tool(contact, tool);
    if (!t)
        return sbi_fail(error, SB_ERROR_INDEX, "there is no tool %d", tool);
    result = sbi_tool_pose_check(pose, "the pose", &unit, error);
    if (result == SB_OK)
        result = sbi_tool_place_check(t->shape, t->chain_reached, &unit, "the pose", error);
    if (result == SB_OK) /* it goes on to bend */
        result = sbi_tool_place_check(t->shape, t->chain_wanted, &unit, "the pose", error);
    if (result == SB_OK)
        result = sbi_contact_check_depth(contact, t->shape, t->chain_reached, &unit, error);
    if (result != SB_OK)
        return result;
    t->reached = t->wanted = t->next = t->balance = t->spring.hand = unit;
    sbi_contact_forget(contact, tool);
    sbi_contact_tell_pose(contact, SBI_CONTACT_PLACE, tool, pose);
    return SB_OK;
}

SB_API sb_result sb_contact_bend_tool(sb_contact *contact, int tool, const sb_vec3 *points)
{
    sbi_contact_tool *t;
    sb_result result;
    int count;
    if (!contact || !points)
        return SB_ERROR_ARGUMENT;
    t = sbi_contact_find_tool(contact, tool);
    if (!t)
        return SB_ERROR_INDEX;
    count = sbi_tool_point_count(t->shape);
    if (count == 0)
        return SB_ERROR_ARGUMENT;
    result = sbi_tool_chain_check(points, count, sbi_tool_radius(t->shape), "points", NULL);
    if (result == SB_OK)
        result = sbi_tool_place_check(t->shape, points, &t->wanted, "points", NULL);
    if (result != SB_OK)
        return result;
    memcpy(t->chain_wanted, points, (size_t)count * sizeof *points);
    sbi_contact_tell(contact, SBI_CONTACT_BEND, tool, &points[0].x, 3 * count);
    return SB_OK;
}

SB_API sb_result sb_contact_set_friction(sb_contact *contact, int tool, sb_real friction)
{
    sbi_contact_tool *t;
    if (!contact)
        return SB_ERROR_ARGUMENT;
    t = sbi_contact_find_tool(contact, tool);
    if (!t)
        return SB_ERROR_INDEX;
    if (!sb_is_finite(friction))
        return SB_ERROR_NOT_FINITE;
    if (!(friction >= 0))
        return SB_ERROR_ARGUMENT;
    t->friction = friction;
    sbi_contact_tell(contact, SBI_CONTACT_FRICTION, tool, &friction, 1);
    return SB_OK;
}

/* ---- readings of a tool ---- */

SB_API sb_result sb_contact_wrench(const sb_contact *contact, int tool, sb_wrench *on_tool)
{
    const sbi_contact_tool *t;
    if (!contact || !on_tool)
        return SB_ERROR_ARGUMENT;
    t = sbi_contact_find_tool(contact, tool);
    if (!t)
        return SB_ERROR_INDEX;
    on_tool->force = sb_v3_scale(-1, t->force);
    on_tool->torque = sb_v3_scale(-1, t->torque);
    return SB_OK;
}

SB_API sb_result sb_contact_reached(const sb_contact *contact, int tool, sb_pose *pose, sb_real *lag)
{
    const sbi_contact_tool *t;
    if (!contact)
        return SB_ERROR_ARGUMENT;
    t = sbi_contact_find_tool(contact, tool);
    if (!t)
        return SB_ERROR_INDEX;
    if (pose)
        *pose = t->reached;
    if (lag)
        *lag = sbi_tool_motion(t->shape, t->chain_reached, &t->reached, t->chain_wanted, &t->wanted);
    return SB_OK;
}
