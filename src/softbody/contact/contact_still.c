/* contact_still: what need not be looked for in every step, since nodes have gone little since it was.
 *
 * A sample is paired with a face that it may touch in the step: one that it is near, and nearer than both coast towards
 * each other and stray from that. How far they stray is foreseen by the step before; where they went farther the step
 * begins again, and looks for all that it ever would.
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
/* More than rounding takes from distances. */
#define SBI_STILL_LOOSE ((sb_real)1.001)
/* Of how much nearer others may come in a step: a face farther than this beyond what is paired is left out in the next
 * one. */
#define SBI_STILL_SOON ((sb_real)1.25)
/* Steps in which a face that could not be left out is not asked again. */
enum { SBI_STILL_RESTS = 3 };
/* Of the shortest organ's faces: the least way that two points may come nearer unforeseen, with what they remember of
 * pressures; and of how far they strayed in the last step. */
#define SBI_STILL_LEEWAY ((sb_real)0.05)
#define SBI_STILL_STRAYS ((sb_real)2)

/* How far control points of faces go when nodes go 1: the sum of weights of each, without their signs. */
static sb_real sbi_still_stretch(const sb_contact *contact)
{
    const int width = contact->faces->width;
    return width <= 4 ? 1 : width == 6 ? 3 : 9;
}

/* ways [organs + 1]: the square of the farthest way of each organ's nodes (m^2), last that of nodes that count for all
 * organs. Becomes by how much a point of each organ and one of any other may come nearer (m). Returns the farthest way
 * of all (m). */
static sb_real sbi_still_close(const sb_contact *contact, sb_real *ways)
{
    const int count = contact->pairs.organ_count;
    const sb_real stretch = sbi_still_stretch(contact), shared = ways[count];
    sb_real most = 0, second = 0;
    int first = 0;
    for (int o = 0; o < count; o++) {
        ways[o] = stretch * sb_sqrt(sb_max(ways[o], shared));
        second = sb_max(second, sb_min(most, ways[o]));
        first = ways[o] > most ? o : first;
        most = sb_max(most, ways[o]);
    }
    for (int o = 0; o < count; o++)
        ways[o] += o == first ? second : most;
    return count > 0 ? most : stretch * sb_sqrt(shared);
}

/* How far points go in this step, as they coast. */
static void sbi_still_coast(sb_contact *contact, const sbi_touch_step *step)
{
    sbi_pairs_still *still = &contact->pairs.still;
    const sbi_face_tree *tree = &contact->faces->tree;
    still->velocity = step->velocity;
    still->dt = step->dt;
    memset(still->coasting, 0, ((size_t)contact->pairs.organ_count + 1) * sizeof(sb_real));
    for (int i = 0; i < tree->node_count; i++) {
        const int node = tree->nodes[i];
        const sb_vec3 way = sb_v3_scale(step->dt, step->velocity[node]);
        sb_real *most = still->coasting + contact->pairs.node_organs[node];
        *most = sb_max(*most, sb_v3_dot(way, way));
    }
    still->ahead = sbi_still_close(contact, still->coasting);
}

/* How near samples have to be to be paired, and how far from all faces those have none: no more than in any step. */
static void sbi_still_narrow(sb_contact *contact, const sbi_touch_step *step)
{
    sbi_pairs *pairs = &contact->pairs;
    const sb_real lean = SBI_PAIR_LEAN;
    sb_real high;
    pairs->leeway = SB_REAL_MAX;
    pairs->still.farthest = pairs->farthest;
    if (step->wide || !(step->dt > 0) || contact->is_explicit)
        return;
    pairs->leeway = sb_max(SBI_STILL_LEEWAY * pairs->shortest, 2 * SBI_STILL_STRAYS * pairs->strayed);
    high = sb_sqrt(1 + lean * lean) * (pairs->distance + pairs->leeway + 2 * pairs->still.ahead);
    pairs->still.farthest = sb_min(pairs->farthest, SBI_STILL_LOOSE * (high + SBI_PAIR_BESIDE * pairs->longest_face));
}

SBI_API int sbi_pairs_foresaw(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    const sbi_face_tree *tree = &contact->faces->tree;
    sb_real square = 0;
    if (!pairs->kinds || contact->is_explicit || contact->is_static)
        return 1;
    pairs->straying = 0;
    for (int i = 0; i < tree->node_count; i++) {
        int node = tree->nodes[i];
        sb_vec3 off = sb_v3_madd(contact->moved[node], -pairs->still.dt, pairs->still.velocity[node]);
        square = sb_max(square, sb_v3_dot(off, off));
    }
    pairs->straying = sbi_still_stretch(contact) * sb_sqrt(square);
    return !(pairs->leeway < SB_REAL_MAX) || 2 * pairs->straying <= pairs->leeway;
}

/* Adds what nodes have gone since the last step began. */
static void sbi_still_follow(sb_contact *contact)
{
    sbi_pairs_still *still = &contact->pairs.still;
    const sbi_face_tree *tree = &contact->faces->tree;
    memset(still->closing, 0, ((size_t)contact->pairs.organ_count + 1) * sizeof(sb_real));
    for (int i = 0; i < tree->node_count; i++) {
        const int node = tree->nodes[i];
        const sb_vec3 way = sb_v3_sub(contact->x[node], still->seen[node]);
        sb_real *most = still->closing + contact->pairs.node_organs[node];
        *most = sb_max(*most, sb_v3_dot(way, way));
        still->seen[node] = contact->x[node];
    }
    still->last = sbi_still_close(contact, still->closing);
    still->gone += still->last;
    for (int o = 0; o < contact->pairs.organ_count; o++)
        still->closed[o] += still->closing[o];
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
    memset(still->closed, 0, (size_t)contact->pairs.organ_count * sizeof(sb_real));
    still->gone = 0;
}

/* Looks anew for faces near others; ways are counted from here. */
static void sbi_still_look(sb_contact *contact, sb_real margin)
{
    sbi_pairs_still *still = &contact->pairs.still;
    sbi_pairs_find_near(contact, contact->pairs.reach + 2 * margin, SBI_NEAR_ANY);
    memcpy(still->near, contact->pairs.near, (size_t)sbi_face_tree_words(contact->faces->face_room) * sizeof(uint64_t));
    for (int f = 0; f < contact->faces->face_end; f++) {
        if (contact->pairs.organs[f] >= 0)
            still->until[f] -= still->closed[contact->pairs.organs[f]];
        still->listed[f] = -1;
    }
    memset(still->closed, 0, (size_t)contact->pairs.organ_count * sizeof(sb_real));
    still->list_count = 0;
    still->gone = 0;
    still->known = 1;
}

SBI_API void sbi_pairs_renew_near(sb_contact *contact, const sbi_touch_step *step)
{
    sbi_pairs *pairs = &contact->pairs;
    sbi_pairs_still *still = &pairs->still;
    const sb_real margin = SBI_STILL_MARGIN * pairs->longest;
    sbi_still_coast(contact, step);
    sbi_still_narrow(contact, step);
    if (pairs->kinds & SB_CONTACT_SELF) {
        sbi_pairs_find_near(contact, pairs->reach, SBI_NEAR_PAIRED);
        return;
    }
    if (!still->known)
        sbi_still_start(contact);
    sbi_still_follow(contact);
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
    const int organ = contact->pairs.organs[face];
    return still->known && organ >= 0 &&
           still->closed[organ] + still->coasting[organ] + still->farthest < still->until[face];
}

/* Keeps in pairs.found what is of another organ than a face; returns how many. */
static int sbi_still_keep_others(sb_contact *contact, int face, int count)
{
    sbi_pairs *pairs = &contact->pairs;
    int kept = 0;
    for (int i = 0; i < count; i++) {
        pairs->found[kept] = pairs->found[i];
        kept += pairs->organs[pairs->found[i]] != pairs->organs[face];
    }
    return kept;
}

/* What a face may come near as long as `near` is, in still->list. 0: no room is left. */
static int sbi_still_list(sb_contact *contact, int face)
{
    sbi_pairs *pairs = &contact->pairs;
    sbi_pairs_still *still = &pairs->still;
    const sb_real margin = SBI_STILL_MARGIN * pairs->longest;
    const int count = sbi_pairs_query(contact, face, pairs->reach + 2 * margin);
    const int kept = sbi_still_keep_others(contact, face, count);
    if (kept > SBI_STILL_LISTED * contact->faces->face_room - still->list_count)
        return 0;
    memcpy(still->list + still->list_count, pairs->found, (size_t)kept * sizeof(int));
    still->listed[face] = still->list_count;
    still->listed_count[face] = kept;
    still->list_count += kept;
    return 1;
}

SBI_API int sbi_pairs_find_coming(sb_contact *contact, int face, const int **list)
{
    sbi_pairs *pairs = &contact->pairs;
    sbi_pairs_still *still = &pairs->still;
    if (still->known && (still->listed[face] >= 0 || sbi_still_list(contact, face))) {
        *list = still->list + still->listed[face];
        return still->listed_count[face];
    }
    *list = pairs->found;
    return sbi_pairs_query(contact, face, pairs->reach);
}

/* Distance (m) that no point of a face, nor its middle, is nearer to one of another organ than; no more than `least`.
 * What is near is in pairs.found. */
static sb_real sbi_still_apart(const sb_contact *contact, int face, int count, sb_real least)
{
    for (int i = 0; i < count; i++)
        least = sb_min(least, sbi_pairs_between(contact, face, contact->pairs.found[i]));
    return least;
}

/* From a point to the nearest one of a face (m). */
static sb_real sbi_still_distance(const sb_contact *contact, int face, sb_vec3 at)
{
    const sbi_contact_faces *faces = contact->faces;
    const int *nodes = sbi_contact_face_nodes(faces, face);
    sb_vec3 x[SB_MAX_FACE_NODES];
    sbi_closest closest;
    for (int a = 0; a < faces->sizes[face]; a++)
        x[a] = contact->x[nodes[a]];
    sbi_closest_on_face(&faces->kinds[faces->sizes[face]], x, at, &closest);
    return sb_v3_norm(sb_v3_sub(at, closest.point));
}

static void sbi_still_put_first(int *found, int i)
{
    const int first = found[i];
    found[i] = found[0];
    found[0] = first;
}

/* Puts the face whose middle is nearest to a point before the others in pairs.found. */
static void sbi_still_begin_with_nearest(sb_contact *contact, int count, sb_vec3 at)
{
    int *found = contact->pairs.found, first = 0;
    sb_real nearest = SB_REAL_MAX;
    for (int i = 0; i < count; i++) {
        const sb_vec3 way = sb_v3_sub(at, contact->pairs.plates[found[i]].middle);
        const sb_real square = sb_v3_dot(way, way);
        first = square < nearest ? i : first;
        nearest = sb_min(nearest, square);
    }
    if (count > 0)
        sbi_still_put_first(found, first);
}

/* The same of a sample alone, or what is not above `enough`. The face that it is nearest to comes before the others in
 * pairs.found: the next sample begins with it, and few others may be nearer. */
static sb_real sbi_still_sample_apart(sb_contact *contact, int count, sb_vec3 at, sb_real enough, sb_real least)
{
    int *found = contact->pairs.found;
    for (int i = 0; least > enough && i < count; i++) {
        sb_real away;
        if (sbi_pairs_is_beyond(contact, found[i], at, least))
            continue;
        away = sbi_still_distance(contact, found[i], at);
        if (away < least)
            sbi_still_put_first(found, i);
        least = sb_min(least, away);
    }
    return least;
}

/* Keeps what in pairs.found may be nearer to a point of a face than `least`; returns how many. */
static int sbi_still_keep_near(sb_contact *contact, int face, int count, sb_real least)
{
    sbi_pairs *pairs = &contact->pairs;
    const sb_vec3 middle = pairs->plates[face].middle;
    const sb_real most = SBI_STILL_LOOSE * (least + pairs->plates[face].radius);
    int kept = 0;
    for (int i = 0; i < count; i++) {
        const int other = pairs->found[i];
        const sb_vec3 way = sb_v3_sub(middle, pairs->plates[other].middle);
        const sb_real reach = most + pairs->plates[other].radius;
        pairs->found[kept] = other;
        kept += sb_v3_dot(way, way) <= reach * reach;
    }
    return kept;
}

/* The least of all samples of a flat face, or what is not above `enough`; 0 where one may be within another organ. */
static sb_real sbi_still_samples_apart(sb_contact *contact, int face, int count, sb_real enough, sb_real least)
{
    const sbi_contact_faces *faces = contact->faces;
    const int *nodes = sbi_contact_face_nodes(faces, face);
    const int parts = sbi_pairs_parts(contact, face, 0), size = faces->sizes[face];
    const sbi_contact_rule *rule = sbi_contact_face_rule(faces, face, parts);
    sbi_still_begin_with_nearest(contact, count, contact->pairs.plates[face].middle);
    for (int i = 0; least > enough && i < rule->count; i++) {
        sb_vec3 at = sbi_contact_mean(rule->weights + (size_t)i * (size_t)size, nodes, size, contact->x);
        least = sbi_still_sample_apart(contact, count, at, enough, least);
        if (i == 0) /* the others look no farther */
            count = sbi_still_keep_near(contact, face, count, least);
    }
    /* no surface is in a ball of this radius around any sample; the balls cover the face: all is on its middle's side
     */
    if (least > contact->pairs.plates[face].radius / (sb_real)parts)
        return least;
    for (int i = 0; least > enough && i < rule->count; i++) {
        sb_vec3 at = sbi_contact_mean(rule->weights + (size_t)i * (size_t)size, nodes, size, contact->x);
        if (sbi_pairs_is_within_others(contact, contact->pairs.organs[face], at, contact->x))
            return 0;
    }
    return least;
}

/* What of other organs is within pairs.reach of a face where the step begins, and more, in pairs.found; returns how
 * many. */
static int sbi_still_find_around(sb_contact *contact, int face)
{
    const sbi_pairs_still *still = &contact->pairs.still;
    if (still->listed[face] < 0)
        return sbi_still_keep_others(contact, face, sbi_pairs_find_around(contact, face, contact->pairs.reach));
    memcpy(contact->pairs.found, still->list + still->listed[face], (size_t)still->listed_count[face] * sizeof(int));
    return still->listed_count[face];
}

SBI_API void sbi_pairs_let_be(sb_contact *contact, int face)
{
    sbi_pairs *pairs = &contact->pairs;
    sbi_pairs_still *still = &pairs->still;
    const int organ = pairs->organs[face];
    sb_real soon, enough, apart;
    int count;
    if (!still->known || organ < 0)
        return;
    soon = still->closing[organ] + still->coasting[organ];
    if (soon > pairs->reach - still->farthest || still->tired[face]-- > 0)
        return;
    still->tired[face] = SBI_STILL_RESTS;
    enough = still->farthest + SBI_STILL_SOON * soon;
    count = sbi_still_find_around(contact, face);
    apart = contact->faces->sizes[face] == 3 ? sbi_still_samples_apart(contact, face, count, enough, pairs->reach)
                                             : sbi_still_apart(contact, face, count, pairs->reach);
    if (apart > enough && !sbi_pairs_is_within_others(contact, organ, pairs->plates[face].middle, contact->x)) {
        still->until[face] = still->closed[organ] + apart;
        still->tired[face] = 0;
    }
}
