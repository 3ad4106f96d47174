/* contact_pairs_state: organs in touch as a part of their own of the body's state, so that contact of tools alone is
 * saved as it was. Faces are named by cell and side, triangles of a skin as those of tools' entries. */
#include <string.h>

#include "../base/bytes.h"
#include "contact_private.h"

enum { SBI_PAIR_VERSION = 4, SBI_PAIR_REALS = 15 };

/* Face k of an entry. */
static void sbi_pair_put_face(const sb_contact *contact, const sbi_pair_entry *entry, int k, sbi_state_out *out)
{
    const sbi_contact_faces *faces = contact->faces;
    int face = k ? entry->other : entry->face;
    uint64_t name;
    if (!contact->skin.source) {
        sbi_part_put_int(out, faces->elements[face]);
        sbi_part_put_int(out, faces->sides[face]);
        return;
    }
    name = contact->pairs.waiting > 0 ? entry->names[k]
                                      : sbi_contact_skin_name(contact, face, sbi_contact_face_nodes(faces, face));
    sbi_part_put_int(out, sbi_int_of(name & 0xFFFFFFFFu));
    sbi_part_put_int(out, sbi_int_of(name >> 32));
}

static void sbi_pair_put_entry(const sb_contact *contact, const sbi_pair_entry *entry, sbi_state_out *out)
{
    sb_real reals[SBI_PAIR_REALS] = {entry->gap, entry->area};
    for (int k = 0; k < 2; k++)
        sbi_pair_put_face(contact, entry, k, out);
    sbi_part_put_int(out, entry->parts);
    sbi_part_put_int(out, entry->sample);
    sbi_part_put_int(out, entry->sticks);
    sbi_contact_pack_vector(entry->traction, reals + 2);
    sbi_contact_pack_vector(entry->point, reals + 5);
    sbi_contact_pack_vector(entry->normal, reals + 8);
    sbi_contact_pack_vector(entry->force, reals + 11);
    reals[14] = entry->left;
    sbi_part_put_reals(out, reals, SBI_PAIR_REALS);
    sbi_part_put_reals(out, entry->shares, SB_MAX_FACE_NODES);
}

static void sbi_pair_save(const void *user, sbi_state_out *out)
{
    const sb_contact *contact = (const sb_contact *)user;
    const sbi_pairs *pairs = &contact->pairs;
    sbi_part_put_int(out, pairs->kinds);
    sbi_part_put_reals(out, &pairs->friction, 1);
    sbi_part_put_reals(out, &pairs->distance, 1);
    sbi_part_put_reals(out, &pairs->strayed, 1);
    sbi_part_put_int(out, pairs->entry_count + pairs->waiting); /* one of them is 0 */
    for (int e = 0; e < pairs->entry_count + pairs->waiting; e++)
        sbi_pair_put_entry(contact, pairs->entries + e, out);
    sbi_part_put_int(out, pairs->pressure_count);
    for (int i = 0; i < pairs->pressure_count; i++) {
        sbi_part_put_int(out, pairs->pressures[i].node);
        sbi_part_put_reals(out, &pairs->pressures[i].value, 1);
    }
}

/* entry->face: -1 where the mesh has no such faces or sample; of a skin they are to be found by their names. */
static void sbi_pair_get_entry(const sb_contact *contact, sbi_part_in *in, int finds, sbi_pair_entry *entry)
{
    sb_real reals[SBI_PAIR_REALS];
    int at[4];
    memset(entry, 0, sizeof *entry);
    for (int i = 0; i < 4; i++) {
        at[i] = sbi_part_get_int(in);
        in->bad |= !contact->skin.source && at[i] < 0;
    }
    for (int k = 0; k < 2; k++)
        entry->names[k] = (uint64_t)(uint32_t)at[2 * k] | (uint64_t)(uint32_t)at[2 * k + 1] << 32;
    entry->parts = sbi_part_get_int(in);
    entry->sample = sbi_part_get_int(in);
    entry->sticks = sbi_part_get_int(in);
    sbi_part_get_reals(in, reals, SBI_PAIR_REALS);
    sbi_part_get_reals(in, entry->shares, SB_MAX_FACE_NODES);
    entry->gap = reals[0], entry->area = reals[1];
    entry->traction = sb_v3(reals[2], reals[3], reals[4]);
    entry->point = sb_v3(reals[5], reals[6], reals[7]);
    entry->normal = sb_v3(reals[8], reals[9], reals[10]);
    entry->force = sb_v3(reals[11], reals[12], reals[13]);
    entry->left = reals[14];
    in->bad |= entry->parts < 1 || entry->parts > SBI_CONTACT_MOST_PARTS || entry->sample < 0 || !(entry->area > 0) ||
               entry->left > 0 || (entry->sticks & ~1);
    entry->face = entry->other = -1;
    if (!finds || in->bad || contact->skin.source)
        return;
    entry->face = sbi_contact_find_face(contact->faces, at[0], at[1]);
    entry->other = entry->face >= 0 ? sbi_contact_find_face(contact->faces, at[2], at[3]) : -1;
    if (entry->other < 0 || !sbi_contact_face_rule(contact->faces, entry->face, entry->parts)->weights ||
        entry->sample >= sbi_contact_face_rule(contact->faces, entry->face, entry->parts)->count)
        entry->face = -1;
}

static sbi_pair_pressure sbi_pair_get_pressure(sbi_part_in *in)
{
    sbi_pair_pressure pressure;
    pressure.node = sbi_part_get_int(in);
    sbi_part_get_reals(in, &pressure.value, 1);
    in->bad |= pressure.node < 0 || !(pressure.value > 0);
    return pressure;
}

static int sbi_pair_get_pressure_count(const sb_contact *contact, sbi_part_in *in)
{
    int count = sbi_part_get_int(in);
    in->bad |= count < 0 || count > (int64_t)contact->corner_room * contact->max_contacts;
    return in->bad ? 0 : count;
}

static sb_result sbi_pair_check(void *user, const sb_body *body, const unsigned char *bytes, size_t size,
                                sb_error *error)
{
    const sb_contact *contact = (const sb_contact *)user;
    sbi_part_in in = sbi_part_read(bytes, size);
    sb_real law[2], strayed;
    int kinds = sbi_part_get_int(&in), count, pressures;
    (void)body;
    sbi_part_get_reals(&in, law, 2);
    sbi_part_get_reals(&in, &strayed, 1);
    in.bad |= !(strayed >= 0);
    if (!in.bad &&
        (kinds != contact->pairs.kinds || law[0] != contact->pairs.friction || law[1] != contact->pairs.distance))
        return sbi_fail(error, SB_ERROR_STATE,
                        "the state is of a contact with other pairs, pair_friction or pair_distance");
    count = sbi_part_get_int(&in);
    if (!in.bad && count > contact->max_contacts)
        return sbi_fail(error, SB_ERROR_STATE, "the state has %d pairs, max_contacts is %d", count,
                        contact->max_contacts);
    for (int e = 0; e < count && !in.bad; e++) {
        sbi_pair_entry entry;
        sbi_pair_get_entry(contact, &in, 0, &entry);
    }
    pressures = sbi_pair_get_pressure_count(contact, &in);
    for (int i = 0; i < pressures && !in.bad; i++)
        (void)sbi_pair_get_pressure(&in);
    if (in.bad || count < 0 || in.left != 0)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved pairs of a contact are damaged");
    return SB_OK;
}

static void sbi_pair_load(void *user, const unsigned char *bytes, size_t size)
{
    sb_contact *contact = (sb_contact *)user;
    sbi_pairs *pairs = &contact->pairs;
    sbi_part_in in = sbi_part_read(bytes, size);
    sb_real law[2];
    int count, pressures, waits = sbi_contact_skin_is_late(contact, 1) && contact->faces_old;
    (void)sbi_part_get_int(&in);
    sbi_part_get_reals(&in, law, 2);
    sbi_part_get_reals(&in, &pairs->strayed, 1);
    count = sbi_part_get_int(&in);
    pairs->entry_count = pairs->pressure_count = pairs->waiting = 0;
    if (!waits && sbi_contact_update_faces(contact, NULL) != SB_OK) /* the next step says so */
        return;
    for (int e = 0; e < count; e++) {
        sbi_pair_entry entry;
        sbi_pair_get_entry(contact, &in, 1, &entry);
        if (contact->skin.source)
            pairs->entries[pairs->waiting++] = entry;
        else if (entry.face >= 0) /* faces may have other numbers here */
            sbi_pairs_insert_entry(pairs, &entry);
    }
    if (!waits && contact->skin.source)
        sbi_contact_skin_take_waiting(contact);
    pressures = sbi_pair_get_pressure_count(contact, &in);
    for (int i = 0; i < pressures; i++) {
        sbi_pair_pressure pressure = sbi_pair_get_pressure(&in);
        if (pressure.node < sbi_contact_body_room(contact))
            pairs->pressures[pairs->pressure_count++] = pressure;
    }
}

/* It has no commands. */
static sb_result sbi_pair_replay(void *user, const int *ints, size_t int_count, const sb_real *reals, size_t real_count,
                                 sb_error *error)
{
    (void)user, (void)ints, (void)int_count, (void)reals, (void)real_count;
    return sbi_fail(error, SB_ERROR_FORMAT, "pairs of organs have no recorded commands");
}

SBI_API sb_result sbi_pairs_join_state(sb_contact *contact, sb_error *error)
{
    sbi_state_part part;
    if (!contact->pairs.kinds)
        return SB_OK;
    memset(&part, 0, sizeof part);
    memcpy(part.name, SBI_PAIRS_PART, sizeof SBI_PAIRS_PART);
    part.version = SBI_PAIR_VERSION;
    part.user = contact;
    part.save = sbi_pair_save;
    part.check = sbi_pair_check;
    part.load = sbi_pair_load;
    part.replay = sbi_pair_replay;
    return sbi_body_join(contact->body, &part, error);
}
