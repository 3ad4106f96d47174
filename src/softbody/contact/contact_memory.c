/* contact_memory: pressures that contact remembers from step to step, so that overlap vanishes where the surface rests.
 *
 * What is remembered is a field over the faces near a tool, linear (of quads bilinear) between their corners: l = sum
 * L_a l_a. After a step each corner takes what its surroundings are pressed in,
 *     l_a <- (l_a + sum w p (p - l) / sum w p) sum w p f / sum w p,    w = L_a dA, f = max(0, 1 - slip / spacing),
 * over the samples in touch: by their force, so that samples may come and go without a jump. One number for each corner
 * is as much as the surface can follow. Of each sample by itself it would never settle: a face cannot meet the tool at
 * all of its samples, ever fewer would bear ever more, and what friction holds would creep all the while. */
#include <string.h>

#include "contact_private.h"

/* Stiffness of samples over that of the matrix at a node below which nothing is remembered there, and from which on
 * all: below 1 pressures swing up whatever the step (a root of (1 + c) z^3 - 3 z^2 + 3 z - 1 beyond 1 at c < 1). Evenly
 * between the two, since the stiffness of samples is a mean that changes as the tool moves. */
#define SBI_CONTACT_FORGETS ((sb_real)2)
#define SBI_CONTACT_REMEMBERS ((sb_real)3)

SBI_API sb_real sbi_contact_corner_share(const sbi_contact_kind *kind, const sb_real *weights, int corner)
{
    int n = kind->corners;
    sb_real share = weights[corner];
    if (kind->nodes >= 2 * n)
        share += (sb_real)0.5 * (weights[n + corner] + weights[n + (corner + n - 1) % n]);
    return kind->nodes > 2 * n ? share + (sb_real)0.25 * weights[2 * n] : share;
}

/* ---- from the list to samples ---- */

SBI_API sbi_contact_keepers sbi_contact_get_keepers(const sb_contact *contact)
{
    const sbi_contact_skin *skin = &contact->skin;
    sbi_contact_keepers keepers;
    keepers.count = skin->source ? skin->list_count : contact->node_count;
    keepers.nodes = skin->source ? skin->list : contact->nodes;
    keepers.place = skin->source ? skin->place : contact->node_place;
    return keepers;
}

SBI_API int sbi_contact_keepers_of(const sb_contact *contact, int place, int keepers[SBI_CONTACT_MOST_KEEPERS],
                                   sb_real shares[SBI_CONTACT_MOST_KEEPERS])
{
    const sbi_contact_skin *skin = &contact->skin;
    int point, count = 0;
    keepers[0] = place;
    shares[0] = 1;
    if (!skin->source)
        return 1;
    point = contact->nodes[place];
    for (int c = point * skin->corners; c < (point + 1) * skin->corners; c++) {
        if (!(skin->shares[c] > 0))
            continue;
        keepers[count] = skin->place[skin->corner_nodes[c]];
        shares[count++] = skin->shares[c];
    }
    return count;
}

SBI_API sb_real sbi_contact_keeper_stiffness(const sb_contact *contact, int keeper)
{
    const sbi_contact_skin *skin = &contact->skin;
    sb_real area;
    if (!skin->source)
        return contact->stiffness_by_node[keeper];
    area = skin->node_areas[skin->list[keeper]];
    return area > 0 ? skin->loads[keeper] / area : 0;
}

/* sums[place].old = what the nodes of a tool's patches remember. */
static void sbi_contact_spread(sb_contact *contact, int tool)
{
    const sbi_contact_keepers keepers = sbi_contact_get_keepers(contact);
    memset(contact->sums, 0, (size_t)keepers.count * sizeof *contact->sums);
    for (int i = 0; i < contact->pressure_count; i++) {
        const sbi_contact_pressure *pressure = contact->pressures + i;
        int place = keepers.place[pressure->node];
        if (pressure->tool == tool && place >= 0)
            contact->sums[place].old = pressure->value;
    }
}

SBI_API sb_real sbi_contact_remembered(const sb_contact *contact, int place)
{
    int keepers[SBI_CONTACT_MOST_KEEPERS];
    sb_real shares[SBI_CONTACT_MOST_KEEPERS], sum = 0;
    int count = sbi_contact_keepers_of(contact, place, keepers, shares);
    for (int i = 0; i < count; i++)
        sum += shares[i] * contact->sums[keepers[i]].old;
    return sum;
}

SBI_API void sbi_contact_remember_pressures(sb_contact *contact)
{
    for (int p = 0, tool = -1; p < contact->patch_count; p++) {
        const sbi_contact_patch *patch = contact->patches + p;
        const sbi_contact_kind *kind = &contact->faces->kinds[contact->faces->sizes[patch->face]];
        sb_real at[SBI_CONTACT_MOST_CORNERS];
        if (patch->tool != tool)
            sbi_contact_spread(contact, patch->tool);
        tool = patch->tool;
        for (int a = 0; a < kind->corners; a++)
            at[a] = sbi_contact_remembered(contact, patch->nodes[a]);
        for (int i = patch->first; i < patch->first + patch->count; i++) {
            sbi_contact_sample *s = contact->samples + i;
            s->memory = 0;
            for (int a = 0; a < kind->corners; a++)
                s->memory += sbi_contact_corner_share(kind, s->weights, a) * at[a];
        }
    }
}

/* ---- from samples to the list ---- */

/* Share of its pressure that a node of a patch must not remember; own: its stiffness over its area. */
static sb_real sbi_contact_doubt(const sb_contact *contact, const sbi_contact_patch *patch, sb_real own)
{
    const sb_real most = SBI_CONTACT_REMEMBERS, least = SBI_CONTACT_FORGETS;
    sb_real k = contact->samples[patch->first].k;
    if (k >= most * own)
        return 0;
    return k > least * own ? (most - k / own) / (most - least) : 1;
}

/* The sums of a node of a face, at the corners of its cell. */
static void sbi_contact_add_to_corners(sb_contact *contact, const sbi_contact_patch *patch, int place,
                                       const sbi_contact_sum *at)
{
    int keepers[SBI_CONTACT_MOST_KEEPERS];
    sb_real shares[SBI_CONTACT_MOST_KEEPERS];
    int count = sbi_contact_keepers_of(contact, place, keepers, shares);
    for (int i = 0; i < count; i++) {
        sbi_contact_sum *sum = contact->sums + keepers[i];
        sum->force += shares[i] * at->force;
        sum->rise += shares[i] * at->rise;
        sum->kept += shares[i] * at->kept;
        if (contact->skin.node_areas[contact->skin.list[keepers[i]]] > 0)
            sum->doubt = sb_max(sum->doubt,
                                sbi_contact_doubt(contact, patch, sbi_contact_keeper_stiffness(contact, keepers[i])));
    }
}

static void sbi_contact_add_sums(sb_contact *contact, const sbi_contact_patch *patch)
{
    sbi_contact_sum points[SBI_CONTACT_MOST_CORNERS];
    const sbi_contact_kind *kind = &contact->faces->kinds[contact->faces->sizes[patch->face]];
    memset(points, 0, sizeof points);
    for (int i = patch->first; i < patch->first + patch->count; i++) {
        const sbi_contact_sample *s = contact->samples + i;
        sb_real fade = sb_max((sb_real)0, 1 - s->slip / sb_sqrt(s->area));
        for (int a = 0; a < kind->corners && s->answer.pressure > 0; a++) {
            sbi_contact_sum *sum = contact->skin.source ? points + a : contact->sums + patch->nodes[a];
            sb_real force = sbi_contact_corner_share(kind, s->weights, a) * s->area * s->answer.pressure;
            sum->force += force;
            sum->rise += force * (s->answer.pressure - s->memory);
            sum->kept += force * fade;
        }
    }
    for (int a = 0; a < kind->corners; a++) {
        int place = patch->nodes[a];
        sbi_contact_sum *sum;
        if (contact->skin.source) {
            sbi_contact_add_to_corners(contact, patch, place, points + a);
            continue;
        }
        sum = contact->sums + place;
        sum->doubt = sb_max(sum->doubt, sbi_contact_doubt(contact, patch, contact->stiffness_by_node[place]));
    }
}

/* Appends what a tool's corners remember now, in the order of places, which is that of its faces. */
static int sbi_contact_append_pressures(sb_contact *contact, int tool, int fades, int count)
{
    const sbi_contact_keepers keepers = sbi_contact_get_keepers(contact);
    for (int k = 0; k < keepers.count; k++) {
        const sbi_contact_sum *sum = contact->sums + k;
        sbi_contact_pressure *fresh = contact->spare_pressures + count;
        if (!(sum->force > 0))
            continue;
        fresh->tool = tool;
        fresh->node = keepers.nodes[k];
        fresh->value = (sum->old + sum->rise / sum->force) * (1 - sum->doubt);
        fresh->value *= fades ? sum->kept / sum->force : 1;
        count += fresh->value > 0;
    }
    return count;
}

SBI_API void sbi_contact_keep_pressures(sb_contact *contact, int fades)
{
    sbi_contact_pressure *fresh = contact->spare_pressures;
    int count = 0;
    for (int p = 0; p < contact->patch_count;) {
        int tool = contact->patches[p].tool;
        sbi_contact_spread(contact, tool);
        for (; p < contact->patch_count && contact->patches[p].tool == tool; p++)
            sbi_contact_add_sums(contact, contact->patches + p);
        count = sbi_contact_append_pressures(contact, tool, fades, count);
    }
    contact->spare_pressures = contact->pressures;
    contact->pressures = fresh;
    contact->pressure_count = count;
}

/* ---- entries ---- */

static int sbi_contact_entry_is_before(const sbi_contact_entry *a, const sbi_contact_entry *b)
{
    if (a->tool != b->tool)
        return a->tool < b->tool;
    return a->face != b->face ? a->face < b->face : a->sample < b->sample;
}

/* Entries go where their order wants them: faces may have other numbers here. */
SBI_API void sbi_contact_insert_entry(sb_contact *contact, const sbi_contact_entry *entry)
{
    int at = contact->entry_count++;
    for (; at > 0 && sbi_contact_entry_is_before(entry, contact->entries + at - 1); at--)
        contact->entries[at] = contact->entries[at - 1];
    contact->entries[at] = *entry;
}

SBI_API void sbi_contact_mark_corners(sb_contact *contact, int face, int mark)
{
    const sbi_contact_skin *skin = &contact->skin;
    const int *nodes = sbi_contact_face_nodes(contact->faces, face);
    for (int a = 0; a < contact->faces->sizes[face]; a++) {
        if (!skin->source)
            contact->node_place[nodes[a]] = mark;
        for (int c = nodes[a] * skin->corners; c < (nodes[a] + 1) * skin->corners; c++)
            skin->place[skin->corner_nodes[c]] = mark;
    }
}

static int sbi_pair_is_before(const sbi_pair_entry *a, const sbi_pair_entry *b)
{
    return a->face != b->face ? a->face < b->face : a->sample < b->sample;
}

SBI_API void sbi_pairs_insert_entry(sbi_pairs *pairs, const sbi_pair_entry *entry)
{
    int at = pairs->entry_count++;
    for (; at > 0 && sbi_pair_is_before(entry, pairs->entries + at - 1); at--)
        pairs->entries[at] = pairs->entries[at - 1];
    pairs->entries[at] = *entry;
}
