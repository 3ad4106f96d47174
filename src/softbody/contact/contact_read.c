/* contact_read: what a contact says of the last step, besides its tools' wrenches. */
#include <string.h>

#include "contact_private.h"

SB_API int sb_contact_points(const sb_contact *contact, sb_contact_point *points, int capacity)
{
    if (!contact)
        return 0;
    for (int e = 0; points && e < contact->entry_count && e < capacity; e++) {
        const sbi_contact_entry *entry = contact->entries + e;
        sb_contact_point *point = points + e;
        memset(point, 0, sizeof *point);
        point->tool = entry->tool;
        point->other_element = point->other_face = -1;
        point->element = contact->faces->elements[entry->face];
        point->face = contact->faces->is_skin ? entry->face : contact->faces->sides[entry->face];
        point->sticks = entry->sticks;
        point->gap = entry->gap;
        point->area = entry->area;
        point->point = entry->point;
        point->normal = entry->normal;
        point->force = entry->force;
    }
    for (int e = 0; points && e < contact->pairs.entry_count && contact->entry_count + e < capacity; e++)
        sbi_pairs_read_point(contact, e, points + contact->entry_count + e);
    return contact->entry_count + contact->pairs.entry_count;
}

SB_API sb_result sb_contact_pressures(const sb_contact *contact, sb_real *pressures)
{
    const sbi_contact_faces *faces;
    int nodes;
    if (!contact || !pressures)
        return SB_ERROR_ARGUMENT;
    faces = contact->faces;
    nodes = sbi_contact_point_count(contact);
    memset(pressures, 0, (size_t)nodes * sizeof *pressures);
    for (int e = 0; e < contact->entry_count; e++) {
        const sbi_contact_entry *entry = contact->entries + e;
        const int *list = sbi_contact_face_nodes(faces, entry->face);
        const sb_real *weights = sbi_contact_sample_weights(faces, entry->face, entry->parts, entry->sample);
        sb_real push = sb_v3_dot(entry->force, entry->normal);
        for (int a = 0; a < faces->sizes[entry->face]; a++)
            pressures[list[a]] += weights[a] * push;
    }
    sbi_pairs_add_pushes(contact, pressures);
    for (int i = 0; i < nodes; i++) {
        sb_real area = sbi_contact_node_area(faces, i);
        pressures[i] = area > 0 ? pressures[i] / area : 0;
    }
    return SB_OK;
}

/* ---- stiffness ---- */

#define SBI_CONTACT_COLUMN_TOLERANCE ((sb_real)1e-3)

/* How a point of a tool moves by its unknown j. */
static sb_vec3 sbi_contact_unit_way(int j, sb_vec3 arm)
{
    sb_vec3 unit = sb_v3((sb_real)(j % 3 == 0), (sb_real)(j % 3 == 1), (sb_real)(j % 3 == 2));
    return j < 3 ? unit : sb_v3_cross(unit, arm);
}

/* Force on the body of an entry whose tool moves by `way` against the tissue. */
static sb_vec3 sbi_contact_way_force(const sbi_contact_entry *entry, sb_vec3 way)
{
    sb_real k[9];
    sbi_contact_stiffness(&entry->answer, entry->normal, entry->area, k);
    return sb_v3(k[0] * way.x + k[1] * way.y + k[2] * way.z, k[3] * way.x + k[4] * way.y + k[5] * way.z,
                 k[6] * way.x + k[7] * way.y + k[8] * way.z);
}

/* rhs = what a tool's way along j loads the nodes with. */
static void sbi_contact_load_column(const sb_contact *contact, int tool, int j, sb_vec3 *rhs)
{
    memset(rhs, 0, (size_t)sb_body_node_count(contact->body) * sizeof *rhs);
    for (int e = 0; e < contact->entry_count; e++) {
        const sbi_contact_entry *entry = contact->entries + e;
        sb_vec3 arm = sb_v3_sub(entry->point, contact->tools[tool].balance.position), force;
        if (entry->tool != tool)
            continue;
        force = sbi_contact_way_force(entry, sbi_contact_unit_way(j, arm));
        sbi_contact_load_sample(contact, entry->face, entry->parts, entry->sample, 1, force, rhs);
    }
}

/* Column j of k, the tissue following by x. */
static void sbi_contact_read_column(const sb_contact *contact, int tool, int j, const sb_vec3 *x, sb_real k[6][6])
{
    for (int e = 0; e < contact->entry_count; e++) {
        const sbi_contact_entry *entry = contact->entries + e;
        sb_vec3 arm = sb_v3_sub(entry->point, contact->tools[tool].balance.position), follows, force, torque;
        if (entry->tool != tool)
            continue;
        follows = sbi_contact_sample_motion(contact, entry->face, entry->parts, entry->sample, x);
        force = sbi_contact_way_force(entry, sb_v3_sub(sbi_contact_unit_way(j, arm), follows));
        torque = sb_v3_cross(arm, force);
        k[0][j] -= force.x, k[1][j] -= force.y, k[2][j] -= force.z;
        k[3][j] -= torque.x, k[4][j] -= torque.y, k[5][j] -= torque.z;
    }
}

static int sbi_contact_has_tool(const sb_contact *contact, int tool)
{
    return tool >= 0 && tool < contact->max_tools && contact->tools[tool].shape != NULL;
}

SB_API sb_result sb_contact_stiffness(sb_contact *contact, int tool, sb_real k[6][6])
{
    if (!contact || !k)
        return SB_ERROR_ARGUMENT;
    if (!sbi_contact_has_tool(contact, tool))
        return SB_ERROR_INDEX;
    if (!contact->is_solved || contact->faces_old)
        return SB_ERROR_STATE;
    memset(k, 0, 36 * sizeof(sb_real));
    for (int j = 0; j < 6; j++) {
        sb_result result;
        sbi_contact_load_column(contact, tool, j, contact->hung_in);
        result =
            sbi_body_solve_column(contact->body, contact->hung_in, contact->hung_out, SBI_CONTACT_COLUMN_TOLERANCE);
        if (result != SB_OK) /* supports or constraints have changed since */
            return result == SB_ERROR_INDEFINITE ? SB_ERROR_STATE : result;
        sbi_contact_read_column(contact, tool, j, contact->hung_out, k);
    }
    return SB_OK;
}

/* ---- a grip ---- */

/* Sums over what a jaw touches. */
typedef struct sbi_grip_sum {
    sb_vec3 push, force;          /* N on the body: without friction, and with it */
    sb_real pushes, stuck, bound; /* N: sums of sizes; of those that stick; most that friction holds */
} sbi_grip_sum;

static sbi_grip_sum sbi_grip_add_up(const sb_contact *contact, int tool)
{
    sbi_grip_sum sum;
    memset(&sum, 0, sizeof sum);
    for (int e = 0; e < contact->entry_count; e++) {
        const sbi_contact_entry *entry = contact->entries + e;
        sb_real push = sb_v3_dot(entry->force, entry->normal);
        if (entry->tool != tool)
            continue;
        sum.push = sb_v3_madd(sum.push, push, entry->normal);
        sum.force = sb_v3_add(sum.force, entry->force);
        sum.pushes += push;
        sum.stuck += entry->sticks ? push : 0;
        sum.bound += contact->tools[tool].friction * push;
    }
    return sum;
}

/* The wrench on a tool about another place. */
static void sbi_grip_add_wrench(const sbi_contact_tool *tool, sb_vec3 place, sb_wrench *sum)
{
    sb_vec3 force = sb_v3_scale(-1, tool->force), arm = sb_v3_sub(tool->balance.position, place);
    sum->force = sb_v3_add(sum->force, force);
    sum->torque = sb_v3_add(sum->torque, sb_v3_sub(sb_v3_cross(arm, force), tool->torque));
}

SB_API sb_result sb_contact_grip(const sb_contact *contact, int jaw, int other, sb_grip *grip)
{
    sbi_grip_sum a, b;
    sb_vec3 axis;
    sb_real size, load;
    if (!contact || !grip)
        return SB_ERROR_ARGUMENT;
    if (jaw == other || !sbi_contact_has_tool(contact, jaw) || !sbi_contact_has_tool(contact, other))
        return SB_ERROR_INDEX;
    memset(grip, 0, sizeof *grip);
    grip->place = sb_v3_scale((sb_real)0.5,
                              sb_v3_add(contact->tools[jaw].balance.position, contact->tools[other].balance.position));
    sbi_grip_add_wrench(contact->tools + jaw, grip->place, &grip->net);
    sbi_grip_add_wrench(contact->tools + other, grip->place, &grip->net);
    a = sbi_grip_add_up(contact, jaw);
    b = sbi_grip_add_up(contact, other);
    axis = sb_v3_sub(a.push, b.push);
    size = sb_v3_norm(axis);
    if (!(a.pushes > 0) || !(b.pushes > 0) || !(size > 0))
        return SB_OK;
    axis = sb_v3_scale(1 / size, axis);
    grip->force = sb_min(sb_v3_dot(a.force, axis), -sb_v3_dot(b.force, axis));
    if (!(grip->force > 0)) { /* they press the same way */
        grip->force = 0;
        return SB_OK;
    }
    grip->axis = axis;
    grip->sticking = (a.stuck + b.stuck) / (a.pushes + b.pushes);
    load = sb_v3_norm(sb_v3_madd(grip->net.force, -sb_v3_dot(grip->net.force, axis), axis));
    grip->used = a.bound + b.bound > 0 ? load / (a.bound + b.bound) : 0;
    return SB_OK;
}

SB_API sb_contact_info sb_contact_get_info(const sb_contact *contact)
{
    sb_contact_info none;
    memset(&none, 0, sizeof none);
    return contact ? contact->info : none;
}
