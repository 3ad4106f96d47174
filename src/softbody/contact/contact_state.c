/* contact_state: a contact in the saved state of its body and in its recording. Shapes of tools are not kept: a state
 * is loaded into a body whose contact has the same tools. Faces are named by cell and side, triangles of a skin by what
 * they are of: numbers may be others where it is made anew. */
#include <string.h>

#include "../base/bytes.h"
#include "contact_private.h"

/* 3: springs of tools; 4: skins; 5: integers of four bytes; 6: names of triangles; 7: how points of skins are held */
enum { SBI_CONTACT_VERSION = 7 };

/* ---- what goes from step to step ---- */

enum { SBI_CONTACT_TOOL_REALS = 37, SBI_CONTACT_ENTRY_REALS = 14 };

static sb_pose sbi_contact_unpack_pose(const sb_real *in)
{
    sb_pose pose;
    pose.position = sb_v3(in[0], in[1], in[2]);
    pose.rotation = sb_quat_make(in[3], in[4], in[5], in[6]);
    return pose;
}

static void sbi_contact_put_tool(const sbi_contact_tool *tool, sbi_state_out *out)
{
    sb_real reals[SBI_CONTACT_TOOL_REALS];
    int points = tool->shape ? sbi_tool_point_count(tool->shape) : 0;
    sbi_part_put_int(out, tool->shape ? (int)sbi_tool_get_shape(tool->shape) : 0);
    if (!tool->shape)
        return;
    sbi_part_put_int(out, points);
    reals[0] = tool->friction;
    sbi_contact_pack_pose(&tool->reached, reals + 1);
    sbi_contact_pack_pose(&tool->wanted, reals + 8);
    sbi_contact_pack_vector(tool->force, reals + 15);
    sbi_contact_pack_vector(tool->torque, reals + 18);
    reals[21] = tool->spring.stiffness, reals[22] = tool->spring.turning, reals[23] = tool->spring.most;
    sbi_contact_pack_pose(&tool->spring.hand, reals + 24);
    sbi_contact_pack_vector(tool->spring.force, reals + 31);
    sbi_contact_pack_vector(tool->spring.torque, reals + 34);
    sbi_part_put_reals(out, reals, SBI_CONTACT_TOOL_REALS);
    for (int i = 0; i < points; i++) {
        sbi_contact_pack_vector(tool->chain_reached[i], reals);
        sbi_contact_pack_vector(tool->chain_wanted[i], reals + 3);
        sbi_part_put_reals(out, reals, 6);
    }
}

static void sbi_contact_put_entry(const sb_contact *contact, const sbi_contact_entry *entry, sbi_state_out *out)
{
    sb_real reals[SBI_CONTACT_ENTRY_REALS] = {entry->gap, entry->area};
    sbi_part_put_int(out, entry->tool);
    if (contact->skin.source) {
        uint64_t name =
            contact->skin.waiting > 0
                ? entry->name
                : sbi_contact_skin_name(contact, entry->face, sbi_contact_face_nodes(contact->faces, entry->face));
        sbi_part_put_int(out, sbi_int_of(name & 0xFFFFFFFFu));
        sbi_part_put_int(out, sbi_int_of(name >> 32));
    } else {
        sbi_part_put_int(out, contact->faces->elements[entry->face]);
        sbi_part_put_int(out, contact->faces->sides[entry->face]);
    }
    sbi_part_put_int(out, entry->parts);
    sbi_part_put_int(out, entry->sample);
    sbi_part_put_int(out, entry->sticks);
    sbi_contact_pack_vector(entry->traction, reals + 2);
    sbi_contact_pack_vector(entry->point, reals + 5);
    sbi_contact_pack_vector(entry->normal, reals + 8);
    sbi_contact_pack_vector(entry->force, reals + 11);
    sbi_part_put_reals(out, reals, SBI_CONTACT_ENTRY_REALS);
}

/* Triangles of a skin; -1 of one whose number changes, 0: none. */
static int sbi_contact_skin_size(const sb_contact *contact)
{
    const sb_skin *source = contact->skin.source;
    return !source ? 0 : source->is_late ? -1 : source->face_count;
}

static void sbi_contact_save(const void *user, sbi_state_out *out)
{
    const sb_contact *contact = (const sb_contact *)user;
    sbi_part_put_int(out, contact->max_tools);
    sbi_part_put_int(out, sbi_contact_skin_size(contact));
    for (int t = 0; t < contact->max_tools; t++)
        sbi_contact_put_tool(contact->tools + t, out);
    sbi_part_put_int(out, contact->entry_count + contact->skin.waiting); /* one of them is 0 */
    for (int e = 0; e < contact->entry_count + contact->skin.waiting; e++)
        sbi_contact_put_entry(contact, contact->entries + e, out);
    sbi_part_put_int(out, contact->pressure_count);
    for (int i = 0; i < contact->pressure_count; i++) {
        sbi_part_put_int(out, contact->pressures[i].tool);
        sbi_part_put_int(out, contact->pressures[i].node);
        sbi_part_put_reals(out, &contact->pressures[i].value, 1);
    }
    if (contact->skin.source && contact->skin.source->save)
        contact->skin.source->save(contact->skin.source, out);
}

/* ---- loading: a check without effect, then the same walk with it ---- */

static sb_result sbi_contact_get_tool(sb_contact *contact, int number, sbi_part_in *in, int takes, sb_error *error)
{
    sbi_contact_tool *tool = contact->tools + number, read = *tool;
    sb_real reals[SBI_CONTACT_TOOL_REALS];
    int shape = sbi_part_get_int(in), points = tool->shape ? sbi_tool_point_count(tool->shape) : 0;
    if (shape != (tool->shape ? (int)sbi_tool_get_shape(tool->shape) : 0))
        return sbi_fail(error, SB_ERROR_STATE, "the state has another tool %d than the contact: make the same first",
                        number);
    if (!tool->shape)
        return SB_OK;
    if (sbi_part_get_int(in) != points)
        return sbi_fail(error, SB_ERROR_STATE, "tool %d of the state has another number of points", number);
    sbi_part_get_reals(in, reals, SBI_CONTACT_TOOL_REALS);
    read.friction = reals[0];
    read.reached = sbi_contact_unpack_pose(reals + 1);
    read.wanted = sbi_contact_unpack_pose(reals + 8);
    read.force = sb_v3(reals[15], reals[16], reals[17]);
    read.torque = sb_v3(reals[18], reals[19], reals[20]);
    read.next = read.balance = read.reached;
    read.nearest.known = 0;
    read.spring.hand = sbi_contact_unpack_pose(reals + 24);
    read.spring.force = sb_v3(reals[31], reals[32], reals[33]);
    read.spring.torque = sb_v3(reals[34], reals[35], reals[36]);
    if (!in->bad &&
        (reals[21] != tool->spring.stiffness || reals[22] != tool->spring.turning || reals[23] != tool->spring.most))
        return sbi_fail(error, SB_ERROR_STATE, "tool %d of the state hangs on another spring", number);
    in->bad |= !(read.friction >= 0) || sb_quat_dot(read.reached.rotation, read.reached.rotation) == 0 ||
               sb_quat_dot(read.wanted.rotation, read.wanted.rotation) == 0 ||
               sb_quat_dot(read.spring.hand.rotation, read.spring.hand.rotation) == 0;
    for (int i = 0; i < points; i++) {
        sbi_part_get_reals(in, reals, 6);
        if (takes) {
            tool->chain_reached[i] = sb_v3(reals[0], reals[1], reals[2]);
            tool->chain_wanted[i] = sb_v3(reals[3], reals[4], reals[5]);
        }
    }
    if (takes)
        *tool = read;
    return SB_OK;
}

SBI_API int sbi_contact_find_face(const sbi_contact_faces *faces, int element, int side)
{
    int low = 0, high = faces->face_end;
    if (faces->is_skin)
        return side == 0 && element < faces->face_end && faces->areas[element] > 0 ? element : -1;
    if (side >= faces->side_count || element > (faces->face_end > 0 ? faces->elements[faces->face_end - 1] : -1))
        return -1;
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (faces->elements[middle] < element || (faces->elements[middle] == element && faces->sides[middle] < side))
            low = middle + 1;
        else
            high = middle;
    }
    return low < faces->face_end && faces->elements[low] == element && faces->sides[low] == side ? low : -1;
}

/* finds: its face becomes that which the mesh has, or -1, also where that has no such sample; of a skin it is to be
 * found by the name. */
static void sbi_contact_get_entry(const sb_contact *contact, sbi_part_in *in, int finds, sbi_contact_entry *entry)
{
    sb_real reals[SBI_CONTACT_ENTRY_REALS];
    int element, side;
    memset(entry, 0, sizeof *entry);
    entry->tool = sbi_part_get_int(in);
    element = sbi_part_get_int(in);
    side = sbi_part_get_int(in);
    entry->parts = sbi_part_get_int(in);
    entry->sample = sbi_part_get_int(in);
    entry->sticks = sbi_part_get_int(in);
    sbi_part_get_reals(in, reals, SBI_CONTACT_ENTRY_REALS);
    entry->gap = reals[0], entry->area = reals[1];
    entry->traction = sb_v3(reals[2], reals[3], reals[4]);
    entry->point = sb_v3(reals[5], reals[6], reals[7]);
    entry->normal = sb_v3(reals[8], reals[9], reals[10]);
    entry->force = sb_v3(reals[11], reals[12], reals[13]);
    in->bad |= entry->tool < 0 || entry->tool >= contact->max_tools || !contact->tools[entry->tool].shape ||
               (!contact->skin.source && (element < 0 || side < 0)) || entry->parts < 1 ||
               entry->parts > SBI_CONTACT_MOST_PARTS || entry->sample < 0 || !(entry->area > 0) || (entry->sticks & ~1);
    entry->face = -1;
    entry->name = (uint64_t)(uint32_t)element | (uint64_t)(uint32_t)side << 32;
    if (!finds || in->bad || contact->skin.source)
        return;
    entry->face = sbi_contact_find_face(contact->faces, element, side);
    if (entry->face >= 0 && entry->sample >= sbi_contact_face_rule(contact->faces, entry->face, entry->parts)->count)
        entry->face = -1;
}

static sbi_contact_pressure sbi_contact_get_pressure(const sb_contact *contact, sbi_part_in *in)
{
    sbi_contact_pressure pressure;
    pressure.tool = sbi_part_get_int(in);
    pressure.node = sbi_part_get_int(in);
    sbi_part_get_reals(in, &pressure.value, 1);
    in->bad |= pressure.tool < 0 || pressure.tool >= contact->max_tools || !contact->tools[pressure.tool].shape ||
               pressure.node < 0 || !(pressure.value > 0);
    return pressure;
}

/* There may be more than corners of the entries: where tools share a face, what one left there stays as long as another
 * has an entry. */
static int sbi_contact_get_pressure_count(const sb_contact *contact, sbi_part_in *in)
{
    int count = sbi_part_get_int(in);
    in->bad |= count < 0 || count > (int64_t)contact->corner_room * contact->max_contacts;
    return in->bad ? 0 : count;
}

static sb_result sbi_contact_check(void *user, const sb_body *body, const unsigned char *bytes, size_t size,
                                   sb_error *error)
{
    sb_contact *contact = (sb_contact *)user;
    sb_skin *source = contact->skin.source;
    sbi_part_in in = sbi_part_read(bytes, size);
    sb_result result = SB_OK;
    int count, pressures;
    if (sbi_part_get_int(&in) != contact->max_tools)
        return sbi_fail(error, SB_ERROR_STATE, "the state is of a contact with another max_tools than %d",
                        contact->max_tools);
    if (sbi_part_get_int(&in) != sbi_contact_skin_size(contact))
        return sbi_fail(error, SB_ERROR_STATE, "the state is of a contact with another skin");
    for (int t = 0; t < contact->max_tools && result == SB_OK; t++)
        result = sbi_contact_get_tool(contact, t, &in, 0, error);
    if (result != SB_OK)
        return result;
    count = sbi_part_get_int(&in);
    if (count > contact->max_contacts)
        return sbi_fail(error, SB_ERROR_STATE, "the state has %d contacts, max_contacts is %d", count,
                        contact->max_contacts);
    for (int e = 0; e < count && !in.bad; e++) {
        sbi_contact_entry entry;
        sbi_contact_get_entry(contact, &in, 0, &entry);
    }
    pressures = sbi_contact_get_pressure_count(contact, &in);
    for (int i = 0; i < pressures && !in.bad; i++)
        (void)sbi_contact_get_pressure(contact, &in);
    if (in.bad || count < 0 || (in.left != 0 && !(source && source->check)))
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved contact is damaged");
    return source && source->check ? source->check(source, body, in, error) : SB_OK;
}

static void sbi_contact_load(void *user, const unsigned char *bytes, size_t size)
{
    sb_contact *contact = (sb_contact *)user;
    sbi_part_in in = sbi_part_read(bytes, size);
    int count, pressures, waits;
    (void)sbi_part_get_int(&in);
    (void)sbi_part_get_int(&in);
    for (int t = 0; t < contact->max_tools; t++)
        (void)sbi_contact_get_tool(contact, t, &in, 1, NULL);
    count = sbi_part_get_int(&in);
    contact->entry_count = contact->pressure_count = 0;
    contact->is_solved = 0;
    memset(&contact->info, 0, sizeof contact->info);
    contact->skin.waiting = 0;
    if (contact->skin.source && contact->skin.source->load && contact->skin.source->load(contact->skin.source))
        contact->faces_old = 1;
    waits = sbi_contact_skin_is_late(contact, 1) && contact->faces_old;
    if (!waits && sbi_contact_update_faces(contact, NULL) != SB_OK) /* the next step says so */
        return;
    for (int e = 0; e < count; e++) {
        sbi_contact_entry entry;
        sbi_contact_get_entry(contact, &in, 1, &entry);
        if (contact->skin.source)
            contact->entries[contact->skin.waiting++] = entry;
        else if (entry.face >= 0)
            sbi_contact_insert_entry(contact, &entry);
    }
    if (!waits && contact->skin.source)
        sbi_contact_skin_take_waiting(contact);
    pressures = sbi_contact_get_pressure_count(contact, &in);
    for (int i = 0; i < pressures; i++) {
        sbi_contact_pressure pressure = sbi_contact_get_pressure(contact, &in);
        if (pressure.node < sbi_contact_body_room(contact))
            contact->pressures[contact->pressure_count++] = pressure;
    }
}

static void sbi_contact_give_up_state(void *user)
{
    sb_skin *source = ((sb_contact *)user)->skin.source;
    if (source && source->give_up)
        source->give_up(source);
}

/* ---- recording ---- */

static sb_result sbi_contact_replay(void *user, const int *ints, size_t int_count, const sb_real *reals,
                                    size_t real_count, sb_error *error)
{
    sb_contact *contact = (sb_contact *)user;
    sb_result result = SB_ERROR_FORMAT;
    sb_pose pose;
    if (int_count == 2 && (ints[0] == SBI_CONTACT_ADD || ints[0] == SBI_CONTACT_REMOVE))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "tool %d was %s during the recording, which cannot be played: begin it afterwards", ints[1],
                        ints[0] == SBI_CONTACT_ADD ? "added" : "removed");
    if (int_count == 2 && ints[0] == SBI_CONTACT_FRICTION && real_count == 1)
        result = sb_contact_set_friction(contact, ints[1], reals[0]);
    if (int_count == 2 && ints[0] == SBI_CONTACT_BEND && ints[1] >= 0 && ints[1] < contact->max_tools &&
        contact->tools[ints[1]].shape &&
        real_count == 3 * (size_t)sbi_tool_point_count(contact->tools[ints[1]].shape) && real_count > 0)
        result = sb_contact_bend_tool(contact, ints[1], (const sb_vec3 *)(const void *)reals);
    if (int_count == 2 && real_count == SBI_CONTACT_POSE_REALS) {
        pose = sbi_contact_unpack_pose(reals);
        if (ints[0] == SBI_CONTACT_MOVE)
            result = sb_contact_move_tool(contact, ints[1], &pose);
        if (ints[0] == SBI_CONTACT_PLACE)
            return sb_contact_place_tool(contact, ints[1], &pose, error);
    }
    return result == SB_OK ? SB_OK : sbi_fail(error, result, "a recorded command to a tool cannot be played");
}

SBI_API sb_result sbi_contact_join_state(sb_contact *contact, sb_error *error)
{
    sbi_state_part part;
    memset(&part, 0, sizeof part);
    memcpy(part.name, SBI_CONTACT_PART, sizeof SBI_CONTACT_PART);
    part.version = SBI_CONTACT_VERSION;
    part.user = contact;
    part.save = sbi_contact_save;
    part.check = sbi_contact_check;
    part.load = sbi_contact_load;
    part.give_up = sbi_contact_give_up_state;
    part.replay = sbi_contact_replay;
    return sbi_body_join(contact->body, &part, error);
}

SBI_API void sbi_contact_leave_state(const sb_contact *contact)
{
    sbi_body_leave(contact->body, SBI_CONTACT_PART);
    sbi_body_leave(contact->body, SBI_PAIRS_PART);
}
