/* contact_pairs_keep: what organs in touch remember from step to step, and what is read of them.
 *
 * Pressures are remembered as those of tools are (contact_memory.c): by corners of faces, each for the samples of its
 * own faces, whatever they are paired with; both sides remember. Tractions are those of samples. */
#include <string.h>

#include "contact_private.h"

/* Of the series of both sides' stiffness at a corner, see contact_memory.c. */
#define SBI_PAIR_FORGETS ((sb_real)2)
#define SBI_PAIR_REMEMBERS ((sb_real)3)
/* Of an overlap that was not pressed in: what a step pushes out. */
#define SBI_PAIR_LETS_OUT ((sb_real)0.2)

/* ---- from the lists to samples ---- */

static void sbi_pair_spread(sb_contact *contact)
{
    const sbi_pairs *pairs = &contact->pairs;
    const sbi_contact_keepers keepers = sbi_contact_get_keepers(contact);
    memset(contact->sums, 0, (size_t)keepers.count * sizeof *contact->sums);
    for (int i = 0; i < pairs->pressure_count; i++) {
        int place = keepers.place[pairs->pressures[i].node];
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
            s->memory += sbi_contact_corner_share(kind, s->weights, a) *
                         sbi_contact_remembered(contact, pairs->patches[s->patch].nodes[a]);
    }
}

/* Overlap at the start of a step, as a gap (m), that it does not push out, of what there is and what the last step
 * left. What appears without having been pressed in would bring in energy from nowhere: it is let out little by little.
 * And parts of a step divide its work to push out what was there before: else it would be thrown out in the first. */
static sb_real sbi_pair_leave(const sb_contact *contact, sb_real gap, sb_real left)
{
    sb_real part = contact->touch.share;
    return sb_max(gap, sb_min(left * (1 - SBI_PAIR_LETS_OUT * part), gap * (1 - part)));
}

SBI_API void sbi_pairs_remember(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    int e = 0;
    for (int i = 0; i < pairs->sample_count; i++) { /* both lists ascend by face and sample */
        sbi_pair_sample *s = pairs->samples + i;
        sb_real gap;
        while (e < pairs->entry_count && (pairs->entries[e].face < s->face ||
                                          (pairs->entries[e].face == s->face && pairs->entries[e].sample < s->sample)))
            e++;
        gap = sb_min((sb_real)0, sb_v3_dot(s->normal, s->start) - pairs->distance);
        s->left = pairs->organs[s->face] == pairs->organs[s->other] ? gap : sbi_pair_leave(contact, gap, gap);
        if (e < pairs->entry_count && pairs->entries[e].face == s->face && pairs->entries[e].sample == s->sample &&
            pairs->entries[e].parts == pairs->patches[s->patch].parts) {
            s->remembered = pairs->entries[e].traction;
            s->left = sbi_pair_leave(contact, gap, pairs->entries[e].left);
        }
    }
    sbi_pairs_remember_pressures(contact);
}

/* ---- from samples to the lists ---- */

/* Share of its pressure that what remembers must not: the matrix is too stiff there for it to be stable. */
static sb_real sbi_pair_doubt(const sb_contact *contact, const sbi_pair_sample *s, int keeper)
{
    const sb_real most = SBI_PAIR_REMEMBERS, least = SBI_PAIR_FORGETS;
    sb_real own = sbi_contact_keeper_stiffness(contact, keeper);
    sb_real other = contact->pairs.region_sum[contact->faces->regions[s->other]];
    sb_real both = own > 0 && other > 0 ? own * (other / (own + other)) : 0;
    if (s->k >= most * both)
        return 0;
    return s->k > least * both ? (most - s->k / both) / (most - least) : 1;
}

/* A force of a sample at a node of its face, by place; kept: the share of it that does not fade. */
static void sbi_pair_add_sum(sb_contact *contact, const sbi_pair_sample *s, int place, sb_real force, sb_real kept)
{
    int keepers[SBI_CONTACT_MOST_KEEPERS];
    sb_real shares[SBI_CONTACT_MOST_KEEPERS];
    int count = sbi_contact_keepers_of(contact, place, keepers, shares);
    for (int i = 0; i < count; i++) {
        sbi_contact_sum *sum = contact->sums + keepers[i];
        sum->force += shares[i] * force;
        sum->rise += shares[i] * force * (s->answer.pressure - s->memory);
        sum->kept += shares[i] * force * kept;
        sum->doubt = sb_max(sum->doubt, sbi_pair_doubt(contact, s, keepers[i]));
    }
}

static void sbi_pair_add_sums(sb_contact *contact, const sbi_pair_sample *s)
{
    const sbi_contact_kind *kind = &contact->faces->kinds[contact->faces->sizes[s->face]];
    const int *nodes = contact->pairs.patches[s->patch].nodes;
    sb_real fade = sb_max((sb_real)0, 1 - s->slip / s->spacing);
    for (int a = 0; a < kind->corners && s->answer.pressure > 0; a++)
        sbi_pair_add_sum(contact, s, nodes[a],
                         sbi_contact_corner_share(kind, s->weights, a) * s->area * s->answer.pressure, fade);
}

SBI_API void sbi_pairs_keep_pressures(sb_contact *contact, int fades)
{
    sbi_pairs *pairs = &contact->pairs;
    sbi_pair_pressure *fresh = pairs->spare_pressures;
    const sbi_contact_keepers keepers = sbi_contact_get_keepers(contact);
    int count = 0;
    if (!pairs->kinds)
        return;
    sbi_pair_spread(contact);
    for (int i = 0; i < pairs->sample_count; i++)
        sbi_pair_add_sums(contact, pairs->samples + i);
    for (int k = 0; pairs->sample_count > 0 && k < keepers.count; k++) {
        const sbi_contact_sum *sum = contact->sums + k;
        if (!(sum->force > 0))
            continue;
        fresh[count].node = keepers.nodes[k];
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
    entry.left = s->left;
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
    const sb_vec3 *rest = sbi_contact_points_at_rest(contact);
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
        sbi_contact_load_sample(contact, entry->face, entry->parts, entry->sample, factor, entry->force, out);
        sbi_contact_load_face(contact, entry->other, entry->shares, -factor, entry->force, out);
    }
}

/* ---- changes of the mesh ---- */

/* Corners remember as long as a face with an entry has them. */
static void sbi_pair_drop_pressures(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    const int *place = sbi_contact_get_keepers(contact).place;
    int count = 0;
    for (int set = 1; set >= 0; set--) {
        for (int e = 0; e < pairs->entry_count; e++)
            sbi_contact_mark_corners(contact, pairs->entries[e].face, set ? 0 : -1);
        for (int i = 0; set && i < pairs->pressure_count; i++)
            if (place[pairs->pressures[i].node] >= 0)
                pairs->pressures[count++] = pairs->pressures[i];
    }
    pairs->pressure_count = count;
}

SBI_API void sbi_pairs_follow_faces(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    const sbi_contact_faces *faces = contact->faces;
    int count = 0;
    if (!pairs->kinds)
        return;
    pairs->link_count = contact->touch.links = 0;
    for (int e = 0; !contact->skin.source && e < pairs->entry_count; e++) { /* those of a skin have followed it */
        sbi_pair_entry entry = pairs->entries[e];
        entry.face = faces->live.moved[entry.face];
        entry.other = faces->live.moved[entry.other];
        if (entry.face >= 0 && entry.other >= 0)
            pairs->entries[count++] = entry;
    }
    if (!contact->skin.source)
        pairs->entry_count = count;
    sbi_pair_drop_pressures(contact);
    sbi_pairs_measure(contact);
}

/* ---- readings ---- */

SBI_API void sbi_pairs_read_point(const sb_contact *contact, int number, sb_contact_point *point)
{
    const sbi_pair_entry *entry = contact->pairs.entries + number;
    memset(point, 0, sizeof *point);
    point->tool = -1;
    point->element = contact->faces->elements[entry->face];
    point->face = contact->faces->is_skin ? entry->face : contact->faces->sides[entry->face];
    point->other_element = contact->faces->elements[entry->other];
    point->other_face = contact->faces->is_skin ? entry->other : contact->faces->sides[entry->other];
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
