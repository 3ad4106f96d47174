/* contact_pairs_state: organs in touch as a part of their own of the body's state, so that contact of tools alone is
 * saved as it was. Faces are named by cell and side. */
#include <string.h>

#include "contact_private.h"

enum { SBI_PAIR_VERSION = 4, SBI_PAIR_REALS = 15 };

static void sbi_pair_put_entry(const sb_contact *contact, const sbi_pair_entry *entry, sbi_state_out *out)
{
    const sbi_contact_faces *faces = contact->faces;
    sb_real reals[SBI_PAIR_REALS] = {entry->gap, entry->area};
    sbi_part_put_int(out, faces->elements[entry->face]);
    sbi_part_put_int(out, faces->sides[entry->face]);
    sbi_part_put_int(out, faces->elements[entry->other]);
    sbi_part_put_int(out, faces->sides[entry->other]);
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
    sbi_part_put_int(out, pairs->entry_count);
    for (int e = 0; e < pairs->entry_count; e++)
        sbi_pair_put_entry(contact, pairs->entries + e, out);
    sbi_part_put_int(out, pairs->pressure_count);
    for (int i = 0; i < pairs->pressure_count; i++) {
        sbi_part_put_int(out, pairs->pressures[i].node);
        sbi_part_put_reals(out, &pairs->pressures[i].value, 1);
    }
}

/* entry->face: -1 where the mesh has no such faces or sample. */
static void sbi_pair_get_entry(const sb_contact *contact, sbi_part_in *in, int finds, sbi_pair_entry *entry)
{
    sb_real reals[SBI_PAIR_REALS];
    int at[4];
    memset(entry, 0, sizeof *entry);
    for (int i = 0; i < 4; i++) {
        at[i] = sbi_part_get_int(in);
        in->bad |= at[i] < 0;
    }
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
    entry->face = finds && !in->bad ? sbi_contact_find_face(contact->faces, at[0], at[1]) : -1;
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

static int sbi_pair_is_before(const sbi_pair_entry *a, const sbi_pair_entry *b)
{
    return a->face != b->face ? a->face < b->face : a->sample < b->sample;
}

/* Entries go where their order wants them: faces may have other numbers here. */
static void sbi_pair_insert(sbi_pairs *pairs, const sbi_pair_entry *entry)
{
    int at = pairs->entry_count++;
    for (; at > 0 && sbi_pair_is_before(entry, pairs->entries + at - 1); at--)
        pairs->entries[at] = pairs->entries[at - 1];
    pairs->entries[at] = *entry;
}

static void sbi_pair_load(void *user, const unsigned char *bytes, size_t size)
{
    sb_contact *contact = (sb_contact *)user;
    sbi_pairs *pairs = &contact->pairs;
    sbi_part_in in = sbi_part_read(bytes, size);
    sb_real law[2];
    int count, pressures;
    (void)sbi_part_get_int(&in);
    sbi_part_get_reals(&in, law, 2);
    sbi_part_get_reals(&in, &pairs->strayed, 1);
    count = sbi_part_get_int(&in);
    pairs->entry_count = pairs->pressure_count = 0;
    if (sbi_contact_update_faces(contact, NULL) != SB_OK) /* the next step says so */
        return;
    for (int e = 0; e < count; e++) {
        sbi_pair_entry entry;
        sbi_pair_get_entry(contact, &in, 1, &entry);
        if (entry.face >= 0)
            sbi_pair_insert(pairs, &entry);
    }
    pressures = sbi_pair_get_pressure_count(contact, &in);
    for (int i = 0; i < pressures; i++) {
        sbi_pair_pressure pressure = sbi_pair_get_pressure(&in);
        if (pressure.node < contact->faces->node_room)
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
