/* contact_pairs_keep: what organs in touch remember from step to step, what is read of them and what is saved.
 *
 * Pressures are remembered as those of tools are (contact_memory.c): by corners of faces, each for the samples of its
 * own faces, whatever they are paired with; both sides remember. Tractions are those of samples. */
#include <string.h>

#include "contact_private.h"

/* Of the series of both sides' stiffness at a corner, see contact_memory.c. */
#define SBI_PAIR_FORGETS ((sb_real)2)
#define SBI_PAIR_REMEMBERS ((sb_real)3)

/* ---- from the lists to samples ---- */

static void sbi_pair_spread(sb_contact *contact)
{
    const sbi_pairs *pairs = &contact->pairs;
    memset(contact->sums, 0, (size_t)contact->touch.node_count * sizeof *contact->sums);
    for (int i = 0; i < pairs->pressure_count; i++) {
        int place = contact->node_place[pairs->pressures[i].node];
        if (place >= 0)
            contact->sums[place].old = pairs->pressures[i].value;
    }
}

SBI_API void sbi_pairs_remember_pressures(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    if (pairs->sample_count == 0)
        return;
    sbi_pair_spread(contact);
    for (int i = 0; i < pairs->sample_count; i++) {
        sbi_pair_sample *s = pairs->samples + i;
        const sbi_contact_kind *kind = &contact->faces->kinds[contact->faces->sizes[s->face]];
        s->memory = 0;
        for (int a = 0; a < kind->corners; a++)
            s->memory +=
                sbi_contact_corner_share(kind, s->weights, a) * contact->sums[pairs->patches[s->patch].nodes[a]].old;
    }
}

SBI_API void sbi_pairs_remember(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    int e = 0;
    for (int i = 0; i < pairs->sample_count; i++) { /* both lists ascend by face and sample */
        sbi_pair_sample *s = pairs->samples + i;
        while (e < pairs->entry_count && (pairs->entries[e].face < s->face ||
                                          (pairs->entries[e].face == s->face && pairs->entries[e].sample < s->sample)))
            e++;
        if (e < pairs->entry_count && pairs->entries[e].face == s->face && pairs->entries[e].sample == s->sample &&
            pairs->entries[e].parts == pairs->patches[s->patch].parts)
            s->remembered = pairs->entries[e].traction;
    }
    sbi_pairs_remember_pressures(contact);
}

/* ---- from samples to the lists ---- */

/* Share of its pressure that a node must not remember: the matrix is too stiff there for it to be stable. */
static sb_real sbi_pair_doubt(const sb_contact *contact, const sbi_pair_sample *s, int place)
{
    const sb_real most = SBI_PAIR_REMEMBERS, least = SBI_PAIR_FORGETS;
    sb_real own = contact->stiffness_by_node[place];
    sb_real other = contact->pairs.region_sum[contact->faces->regions[s->other]];
    sb_real both = own > 0 && other > 0 ? own * (other / (own + other)) : 0;
    if (s->k >= most * both)
        return 0;
    return s->k > least * both ? (most - s->k / both) / (most - least) : 1;
}

static void sbi_pair_add_sums(sb_contact *contact, const sbi_pair_sample *s)
{
    const sbi_contact_kind *kind = &contact->faces->kinds[contact->faces->sizes[s->face]];
    const int *nodes = contact->pairs.patches[s->patch].nodes;
    sb_real fade = sb_max((sb_real)0, 1 - s->slip / s->spacing);
    for (int a = 0; a < kind->corners && s->answer.pressure > 0; a++) {
        sbi_contact_sum *sum = contact->sums + nodes[a];
        sb_real force = sbi_contact_corner_share(kind, s->weights, a) * s->area * s->answer.pressure;
        sum->force += force;
        sum->rise += force * (s->answer.pressure - s->memory);
        sum->kept += force * fade;
        sum->doubt = sb_max(sum->doubt, sbi_pair_doubt(contact, s, nodes[a]));
    }
}

SBI_API void sbi_pairs_keep_pressures(sb_contact *contact, int fades)
{
    sbi_pairs *pairs = &contact->pairs;
    sbi_pair_pressure *fresh = pairs->spare_pressures;
    int count = 0;
    if (!pairs->kinds)
        return;
    sbi_pair_spread(contact);
    for (int i = 0; i < pairs->sample_count; i++)
        sbi_pair_add_sums(contact, pairs->samples + i);
    for (int k = 0; pairs->sample_count > 0 && k < contact->touch.node_count; k++) {
        const sbi_contact_sum *sum = contact->sums + k;
        if (!(sum->force > 0))
            continue;
        fresh[count].node = contact->nodes[k];
        fresh[count].value = (sum->old + sum->rise / sum->force) * (1 - sum->doubt);
        fresh[count].value *= fades ? sum->kept / sum->force : 1;
        count += fresh[count].value > 0;
    }
    pairs->spare_pressures = pairs->pressures;
    pairs->pressures = fresh;
    pairs->pressure_count = count;
}

static sbi_pair_entry sbi_pair_make_entry(const sb_contact *contact, const sbi_pair_sample *s)
{
    const sbi_pairs *pairs = &contact->pairs;
    const sbi_pair_patch *patch = pairs->patches + s->patch;
    sbi_pair_entry entry;
    memset(&entry, 0, sizeof entry);
    entry.face = s->face;
    entry.parts = patch->parts;
    entry.sample = s->sample;
    entry.other = s->other;
    entry.sticks = s->answer.state == SBI_CONTACT_STICKS;
    entry.gap = s->gap;
    entry.area = s->area;
    memcpy(entry.shares, s->shares, sizeof entry.shares);
    entry.traction = s->answer.traction;
    entry.point = s->point;
    entry.normal = s->normal;
    entry.force = sb_v3_scale(s->area, sb_v3_madd(s->answer.traction, s->answer.pressure, s->normal));
    return entry;
}

SBI_API void sbi_pairs_keep_entries(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    sbi_pair_entry *fresh = pairs->spare;
    int count = 0;
    if (!pairs->kinds)
        return;
    for (int i = 0; i < pairs->active_count; i++) {
        const sbi_pair_sample *s = pairs->samples + pairs->active[i];
        if (!(s->answer.pressure > 0))
            continue;
        fresh[count] = sbi_pair_make_entry(contact, s);
        contact->step_info.sticking += fresh[count++].sticks;
        contact->step_info.deepest = sb_max(contact->step_info.deepest, -s->gap);
    }
    contact->step_info.touching += count;
    pairs->spare = pairs->entries;
    pairs->entries = fresh;
    pairs->entry_count = count;
}

SBI_API void sbi_pairs_measure_overlap(const sb_contact *contact, sb_real *overlap, sb_real *pushed)
{
    const sbi_pairs *pairs = &contact->pairs;
    const sb_vec3 *rest = sb_body_rest_positions(contact->body);
    for (int i = 0; i < pairs->active_count; i++) {
        const sbi_pair_sample *s = pairs->samples + pairs->active[i];
        const int *nodes = sbi_contact_face_nodes(contact->faces, s->face);
        sb_vec3 home = sbi_contact_mean(s->weights, nodes, contact->faces->sizes[s->face], rest);
        if (!(s->answer.pressure > 0))
            continue;
        *overlap = sb_max(*overlap, -s->gap);
        *pushed = sb_max(*pushed, sb_abs(sb_v3_dot(sb_v3_sub(s->point, home), s->normal)));
    }
}

SBI_API void sbi_pairs_add_done(const sb_contact *contact, sb_real factor, sb_vec3 *out)
{
    const sbi_pairs *pairs = &contact->pairs;
    for (int e = 0; e < pairs->entry_count; e++) {
        const sbi_pair_entry *entry = pairs->entries + e;
        const int *nodes = sbi_contact_face_nodes(contact->faces, entry->face);
        const int *others = sbi_contact_face_nodes(contact->faces, entry->other);
        const sb_real *weights = sbi_contact_sample_weights(contact->faces, entry->face, entry->parts, entry->sample);
        for (int a = 0; a < contact->faces->sizes[entry->face]; a++)
            out[nodes[a]] = sb_v3_madd(out[nodes[a]], factor * weights[a], entry->force);
        for (int a = 0; a < contact->faces->sizes[entry->other]; a++)
            out[others[a]] = sb_v3_madd(out[others[a]], -factor * entry->shares[a], entry->force);
    }
}

/* ---- undo of static solves, changes of the mesh ---- */

SBI_API void sbi_pairs_keep_before(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    if (!pairs->kinds)
        return;
    pairs->before_count = pairs->entry_count;
    memcpy(pairs->before, pairs->entries, (size_t)pairs->entry_count * sizeof *pairs->entries);
    pairs->before_pressure_count = pairs->pressure_count;
    memcpy(pairs->before_pressures, pairs->pressures, (size_t)pairs->pressure_count * sizeof *pairs->pressures);
}

SBI_API void sbi_pairs_take_before(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    if (!pairs->kinds)
        return;
    pairs->entry_count = pairs->before_count;
    memcpy(pairs->entries, pairs->before, (size_t)pairs->before_count * sizeof *pairs->entries);
    pairs->pressure_count = pairs->before_pressure_count;
    memcpy(pairs->pressures, pairs->before_pressures, (size_t)pairs->pressure_count * sizeof *pairs->pressures);
}

SBI_API void sbi_pairs_follow_faces(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    const sbi_contact_faces *faces = contact->faces;
    int count = 0;
    pairs->link_count = contact->touch.links = 0;
    for (int e = 0; e < pairs->entry_count; e++) {
        sbi_pair_entry entry = pairs->entries[e];
        entry.face = faces->live.moved[entry.face];
        entry.other = faces->live.moved[entry.other];
        if (entry.face >= 0 && entry.other >= 0)
            pairs->entries[count++] = entry;
    }
    pairs->entry_count = count;
    count = 0;
    for (int set = 1; set >= 0; set--) { /* corners remember as long as a face with an entry has them */
        for (int e = 0; e < pairs->entry_count; e++)
            for (int a = 0; a < faces->sizes[pairs->entries[e].face]; a++)
                contact->node_place[sbi_contact_face_nodes(faces, pairs->entries[e].face)[a]] = set ? 0 : -1;
        for (int i = 0; set && i < pairs->pressure_count; i++)
            if (contact->node_place[pairs->pressures[i].node] >= 0)
                pairs->pressures[count++] = pairs->pressures[i];
    }
    pairs->pressure_count = count;
    sbi_pairs_measure(contact);
}

/* ---- readings ---- */

SBI_API void sbi_pairs_read_point(const sb_contact *contact, int number, sb_contact_point *point)
{
    const sbi_pair_entry *entry = contact->pairs.entries + number;
    memset(point, 0, sizeof *point);
    point->tool = -1;
    point->element = contact->faces->elements[entry->face];
    point->face = contact->faces->sides[entry->face];
    point->other_element = contact->faces->elements[entry->other];
    point->other_face = contact->faces->sides[entry->other];
    point->sticks = entry->sticks;
    point->gap = entry->gap;
    point->area = entry->area;
    point->point = entry->point;
    point->normal = entry->normal;
    point->force = entry->force;
}

SBI_API void sbi_pairs_add_pushes(const sb_contact *contact, sb_real *pushes)
{
    const sbi_contact_faces *faces = contact->faces;
    for (int e = 0; e < contact->pairs.entry_count; e++) {
        const sbi_pair_entry *entry = contact->pairs.entries + e;
        const int *nodes = sbi_contact_face_nodes(faces, entry->face);
        const int *others = sbi_contact_face_nodes(faces, entry->other);
        const sb_real *weights = sbi_contact_sample_weights(faces, entry->face, entry->parts, entry->sample);
        sb_real push = sb_v3_dot(entry->force, entry->normal);
        for (int a = 0; a < faces->sizes[entry->face]; a++)
            pushes[nodes[a]] += weights[a] * push;
        for (int a = 0; a < faces->sizes[entry->other]; a++)
            pushes[others[a]] += entry->shares[a] * push;
    }
}

/* ---- state: a part of its own, so that contact of tools alone is saved as it was ---- */

enum { SBI_PAIR_VERSION = 1, SBI_PAIR_REALS = 14 };

static void sbi_pair_put_entry(const sb_contact *contact, const sbi_pair_entry *entry, sbi_state_out *out)
{
    const sbi_contact_faces *faces = contact->faces;
    sb_real reals[SBI_PAIR_REALS] = {entry->gap, entry->area};
    sbi_contact_put_int(out, faces->elements[entry->face]);
    sbi_contact_put_int(out, faces->sides[entry->face]);
    sbi_contact_put_int(out, faces->elements[entry->other]);
    sbi_contact_put_int(out, faces->sides[entry->other]);
    sbi_contact_put_int(out, entry->parts);
    sbi_contact_put_int(out, entry->sample);
    sbi_contact_put_int(out, entry->sticks);
    sbi_contact_pack_vector(entry->traction, reals + 2);
    sbi_contact_pack_vector(entry->point, reals + 5);
    sbi_contact_pack_vector(entry->normal, reals + 8);
    sbi_contact_pack_vector(entry->force, reals + 11);
    sbi_contact_put_reals(out, reals, SBI_PAIR_REALS);
    sbi_contact_put_reals(out, entry->shares, SB_MAX_FACE_NODES);
}

static void sbi_pair_save(const void *user, sbi_state_out *out)
{
    const sb_contact *contact = (const sb_contact *)user;
    const sbi_pairs *pairs = &contact->pairs;
    sbi_contact_put_int(out, pairs->kinds);
    sbi_contact_put_reals(out, &pairs->friction, 1);
    sbi_contact_put_reals(out, &pairs->distance, 1);
    sbi_contact_put_int(out, pairs->entry_count);
    for (int e = 0; e < pairs->entry_count; e++)
        sbi_pair_put_entry(contact, pairs->entries + e, out);
    sbi_contact_put_int(out, pairs->pressure_count);
    for (int i = 0; i < pairs->pressure_count; i++) {
        sbi_contact_put_int(out, pairs->pressures[i].node);
        sbi_contact_put_reals(out, &pairs->pressures[i].value, 1);
    }
}

/* entry->face: -1 where the mesh has no such faces or sample. */
static void sbi_pair_get_entry(const sb_contact *contact, sbi_contact_in *in, int finds, sbi_pair_entry *entry)
{
    sb_real reals[SBI_PAIR_REALS];
    int at[4];
    memset(entry, 0, sizeof *entry);
    for (int i = 0; i < 4; i++) {
        at[i] = sbi_contact_get_int(in);
        in->bad |= at[i] < 0;
    }
    entry->parts = sbi_contact_get_int(in);
    entry->sample = sbi_contact_get_int(in);
    entry->sticks = sbi_contact_get_int(in);
    sbi_contact_get_reals(in, reals, SBI_PAIR_REALS);
    sbi_contact_get_reals(in, entry->shares, SB_MAX_FACE_NODES);
    entry->gap = reals[0], entry->area = reals[1];
    entry->traction = sb_v3(reals[2], reals[3], reals[4]);
    entry->point = sb_v3(reals[5], reals[6], reals[7]);
    entry->normal = sb_v3(reals[8], reals[9], reals[10]);
    entry->force = sb_v3(reals[11], reals[12], reals[13]);
    in->bad |= entry->parts < 1 || entry->parts > SBI_CONTACT_MOST_PARTS || entry->sample < 0 || !(entry->area > 0) ||
               (entry->sticks & ~1);
    entry->face = finds && !in->bad ? sbi_contact_find_face(contact->faces, at[0], at[1]) : -1;
    entry->other = entry->face >= 0 ? sbi_contact_find_face(contact->faces, at[2], at[3]) : -1;
    if (entry->other < 0 || !sbi_contact_face_rule(contact->faces, entry->face, entry->parts)->weights ||
        entry->sample >= sbi_contact_face_rule(contact->faces, entry->face, entry->parts)->count)
        entry->face = -1;
}

static sbi_pair_pressure sbi_pair_get_pressure(sbi_contact_in *in)
{
    sbi_pair_pressure pressure;
    pressure.node = sbi_contact_get_int(in);
    sbi_contact_get_reals(in, &pressure.value, 1);
    in->bad |= pressure.node < 0 || !(pressure.value > 0);
    return pressure;
}

static int sbi_pair_get_pressure_count(sbi_contact_in *in, int contacts)
{
    int count = sbi_contact_get_int(in);
    in->bad |= count < 0 || count > SBI_CONTACT_MOST_CORNERS * contacts;
    return in->bad ? 0 : count;
}

static sb_result sbi_pair_check(void *user, const sb_body *body, const unsigned char *bytes, size_t size,
                                sb_error *error)
{
    const sb_contact *contact = (const sb_contact *)user;
    sbi_contact_in in = {bytes, size, 0};
    sb_real law[2];
    int kinds = sbi_contact_get_int(&in), count, pressures;
    (void)body;
    sbi_contact_get_reals(&in, law, 2);
    if (!in.bad &&
        (kinds != contact->pairs.kinds || law[0] != contact->pairs.friction || law[1] != contact->pairs.distance))
        return sbi_fail(error, SB_ERROR_STATE,
                        "the state is of a contact with other pairs, pair_friction or pair_distance");
    count = sbi_contact_get_int(&in);
    if (!in.bad && count > contact->max_contacts)
        return sbi_fail(error, SB_ERROR_STATE, "the state has %d pairs, max_contacts is %d", count,
                        contact->max_contacts);
    for (int e = 0; e < count && !in.bad; e++) {
        sbi_pair_entry entry;
        sbi_pair_get_entry(contact, &in, 0, &entry);
    }
    pressures = sbi_pair_get_pressure_count(&in, count);
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
    sbi_contact_in in = {bytes, size, 0};
    sb_real law[2];
    int count, pressures;
    (void)sbi_contact_get_int(&in);
    sbi_contact_get_reals(&in, law, 2);
    count = sbi_contact_get_int(&in);
    pairs->entry_count = pairs->pressure_count = 0;
    if (sbi_contact_update_faces(contact, NULL) != SB_OK) /* the next step says so */
        return;
    for (int e = 0; e < count; e++) {
        sbi_pair_entry entry;
        sbi_pair_get_entry(contact, &in, 1, &entry);
        if (entry.face >= 0)
            sbi_pair_insert(pairs, &entry);
    }
    pressures = sbi_pair_get_pressure_count(&in, count);
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
