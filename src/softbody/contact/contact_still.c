/* contact_still: what need not be looked for in every step, since nodes have gone little since it was.
 *
 * Faces near those of other organs are kept as long as nothing has gone farther than the margin that they were looked
 * for with. Of those, faces that are surely too far from all other organs for any partner are left out until what moves
 * may have brought them near enough. Both are bounds on what the search would find: what is left out has no partner,
 * so that steps are those without it, to the last bit. Places are compared with those where the last step began,
 * whatever has moved them since.
 *
 * An organ that may touch itself is looked at in every step: its faces near each other are most of all. */
#include <string.h>

#include "contact_private.h"

/* Of the longest organ's faces: how much farther faces are looked for. */
#define SBI_STILL_MARGIN ((sb_real)0.2)
/* Of that way: what moves more in a step is looked at in the next one anyway. */
#define SBI_STILL_FAST ((sb_real)0.5)
/* Steps in which a face that could not be left out is not asked again. */
enum { SBI_STILL_RESTS = 8 };

/* How far control points of faces go when nodes go 1: the sum of weights of each, without their signs. */
static sb_real sbi_still_stretch(const sb_contact *contact)
{
    const int width = contact->faces->width;
    return width <= 4 ? 1 : width == 6 ? 3 : 9;
}

/* Adds what nodes have gone since the last step began, and foresees this one. */
static void sbi_still_follow(sb_contact *contact, const sbi_touch_step *step)
{
    sbi_pairs_still *still = &contact->pairs.still;
    const sbi_face_tree *tree = &contact->faces->tree;
    sb_real gone = 0, ahead = 0;
    for (int i = 0; i < tree->node_count; i++) {
        int node = tree->nodes[i];
        sb_vec3 way = sb_v3_sub(contact->x[node], still->seen[node]), v = step->velocity[node];
        gone = sb_max(gone, sb_v3_dot(way, way));
        ahead = sb_max(ahead, sb_v3_dot(v, v));
        still->seen[node] = contact->x[node];
    }
    still->last = sbi_still_stretch(contact) * sb_sqrt(gone);
    still->gone += still->last;
    still->ahead = sbi_still_stretch(contact) * step->dt * sb_sqrt(ahead);
}

/* Forgets all, where the step begins. */
static void sbi_still_start(sb_contact *contact)
{
    sbi_pairs_still *still = &contact->pairs.still;
    const sbi_face_tree *tree = &contact->faces->tree;
    for (int i = 0; i < tree->node_count; i++)
        still->seen[tree->nodes[i]] = contact->x[tree->nodes[i]];
    memset(still->until, 0, (size_t)contact->faces->face_room * sizeof(sb_real));
    memset(still->tired, 0, (size_t)contact->faces->face_room);
    still->gone = 0;
}

/* Looks anew for faces near others; ways are counted from here. */
static void sbi_still_look(sb_contact *contact, sb_real margin)
{
    sbi_pairs_still *still = &contact->pairs.still;
    sbi_pairs_find_near(contact, contact->pairs.reach + 2 * margin, SBI_NEAR_ANY);
    memcpy(still->near, contact->pairs.near, (size_t)sbi_face_tree_words(contact->faces->face_room) * sizeof(uint64_t));
    for (int f = 0; f < contact->faces->face_end; f++)
        still->until[f] -= still->gone;
    still->gone = 0;
    still->known = 1;
}

SBI_API void sbi_pairs_renew_near(sb_contact *contact, const sbi_touch_step *step)
{
    sbi_pairs *pairs = &contact->pairs;
    sbi_pairs_still *still = &pairs->still;
    const sb_real margin = SBI_STILL_MARGIN * pairs->longest;
    if (pairs->kinds & SB_CONTACT_SELF) {
        sbi_pairs_find_near(contact, pairs->reach, SBI_NEAR_PAIRED);
        return;
    }
    if (!still->known)
        sbi_still_start(contact);
    sbi_still_follow(contact, step);
    if (still->known && still->gone + still->ahead < margin)
        memcpy(pairs->near, still->near, (size_t)sbi_face_tree_words(contact->faces->face_room) * sizeof(uint64_t));
    else if (still->last + still->ahead < SBI_STILL_FAST * margin)
        sbi_still_look(contact, margin);
    else {
        sbi_pairs_find_near(contact, pairs->reach, SBI_NEAR_PAIRED);
        still->known = 0;
    }
}

SBI_API int sbi_pairs_is_still(const sb_contact *contact, int face)
{
    const sbi_pairs_still *still = &contact->pairs.still;
    return still->known && still->gone + still->ahead < still->until[face];
}

/* Distance (m) that no point of a face, nor its middle, is nearer to one of another organ than; no more than `least`.
 * What is near is in pairs.found. */
static sb_real sbi_still_apart(const sb_contact *contact, int face, int count, sb_real least)
{
    const sbi_pairs *pairs = &contact->pairs;
    for (int i = 0; i < count; i++)
        if (pairs->organs[pairs->found[i]] != pairs->organs[face])
            least = sb_min(least, sbi_pairs_between(contact, face, pairs->found[i]));
    return least;
}

/* The same of a sample alone. */
static sb_real sbi_still_sample_apart(const sb_contact *contact, int face, int count, sb_vec3 at, sb_real least)
{
    const sbi_pairs *pairs = &contact->pairs;
    const sbi_contact_faces *faces = contact->faces;
    for (int i = 0; i < count; i++) {
        int other = pairs->found[i];
        sb_vec3 x[SB_MAX_FACE_NODES], way = sb_v3_sub(at, pairs->middles[other]);
        sb_real reach = least + pairs->radii[other];
        sbi_closest closest;
        if (pairs->organs[other] == pairs->organs[face] || sb_v3_dot(way, way) > reach * reach)
            continue;
        for (int a = 0; a < faces->sizes[other]; a++)
            x[a] = contact->x[sbi_contact_face_nodes(faces, other)[a]];
        sbi_closest_on_face(&faces->kinds[faces->sizes[other]], x, at, &closest);
        least = sb_min(least, sb_v3_norm(sb_v3_sub(at, closest.point)));
    }
    return least;
}

/* The least of all samples of a flat face; 0 where the face between them may be touched. */
static sb_real sbi_still_samples_apart(const sb_contact *contact, int face, int count, sb_real least)
{
    const sbi_contact_faces *faces = contact->faces;
    const int *nodes = sbi_contact_face_nodes(faces, face);
    const int parts = sbi_pairs_parts(contact, face, 0), size = faces->sizes[face];
    const sbi_contact_rule *rule = sbi_contact_face_rule(faces, face, parts);
    for (int i = 0; i < rule->count; i++) {
        sb_vec3 at = sbi_contact_mean(rule->weights + (size_t)i * (size_t)size, nodes, size, contact->x);
        least = sbi_still_sample_apart(contact, face, count, at, least);
    }
    /* every point of it is within an edge's part of a sample */
    return least > 2 * contact->pairs.radii[face] / (sb_real)parts ? least : 0;
}

SBI_API void sbi_pairs_let_be(sb_contact *contact, int face)
{
    sbi_pairs *pairs = &contact->pairs;
    sbi_pairs_still *still = &pairs->still;
    sb_real slack, soon = still->last + still->ahead;
    int count;
    if (!still->known || 2 * soon > pairs->reach - pairs->farthest || still->tired[face]-- > 0)
        return;
    still->tired[face] = SBI_STILL_RESTS;
    count = sbi_pairs_find_around(contact, face, pairs->reach);
    slack = (contact->faces->sizes[face] == 3 ? sbi_still_samples_apart(contact, face, count, pairs->reach)
                                              : sbi_still_apart(contact, face, count, pairs->reach)) -
            pairs->farthest;
    if (slack > 4 * soon &&
        !sbi_pairs_is_within_others(contact, pairs->organs[face], pairs->middles[face], contact->x)) {
        still->until[face] = still->gone + slack / 2;
        still->tired[face] = 0;
    }
}
