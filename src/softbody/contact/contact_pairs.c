/* contact_pairs: organs in touch within a step: samples and what they are paired with, forces, blocks, what couples. */
#include "contact_pairs.h"

#include <math.h>
#include <string.h>

#include "../body/body_private.h"
#include "contact_private.h"

enum { SBI_PAIR_CHUNK = 64, SBI_PAIR_THINNEST = 5, SBI_PAIR_MOST_PARTS = 1024 };

/* Of the body's own stiffness at the surface, for the two sides' harmonic mean. */
#define SBI_PAIR_STIFFNESS ((sb_real)3)
/* In lengths of a face: how far a sample may lie beside the point it is paired with. */
#define SBI_PAIR_BESIDE ((sb_real)1e-3)
/* The way from y to x may lean against the normal so far, as faces of a coarse curved surface make it; and where it
 * goes into the other organ, whose nearest point then lies within a face, or is none of this way at all. */
#define SBI_PAIR_LEAN ((sb_real)0.7)
#define SBI_PAIR_LEAN_INSIDE ((sb_real)0.02)
/* Of a face's length: overlap deeper than this is looked at from all sides. */
#define SBI_PAIR_DEEP ((sb_real)0.1)
/* Of its depth: where a face of any look is nearer than that, a sample is not held by this one. */
#define SBI_PAIR_SIDE ((sb_real)0.9)
/* Faces whose normals have a product below this do not look the same way. */
#define SBI_PAIR_TURNED ((sb_real)0.5)
/* What lies so far behind a face lies no farther beside it, in these, than what leans by that: sqrt(1 / 0.5^2 - 1). */
#define SBI_PAIR_SLANTED ((sb_real)1.7330)
/* Of the thickness: what lies deeper is taken to be on the other side. */
#define SBI_PAIR_DEEPEST ((sb_real)0.5)
/* Of what is safe: a step at whose end samples would be deeper than this, if nothing held them, is divided at once. */
#define SBI_PAIR_COASTS ((sb_real)2)

/* ---- pairing ---- */

/* A sample of a face while its partner is looked for. */
typedef struct sbi_pair_search {
    sb_contact *contact;
    const sbi_touch_step *step;
    int face, others; /* the others are in pairs->found */
    sb_vec3 at, way;  /* m: at the start; over the step, as it coasts */
    int best;         /* -1: none */
    sb_real measure;
    int nearest; /* face whose point is nearest, whether or not it may be paired with; -1: none */
    sb_real nearest_away, nearest_height;
    int within_organ, within; /* whether the sample lies in this organ; -1: none was asked for */
    sbi_closest closest;
} sbi_pair_search;

/* Deepest overlap with a face at which a point is surely on this side of it (m). */
static sb_real sbi_pair_deepest(const sbi_pairs *pairs, int face)
{
    return SBI_PAIR_DEEPEST * sb_min(pairs->thickness[face], 2 * pairs->organ_lengths[pairs->organs[face]]);
}

static void sbi_pair_gather(const sb_contact *contact, int face, sb_vec3 *x)
{
    const int *nodes = sbi_contact_face_nodes(contact->faces, face);
    for (int a = 0; a < contact->faces->sizes[face]; a++)
        x[a] = contact->x[nodes[a]];
}

/* 1 when no point of a face is within `most` (m) of the sample where the step begins. */
static int sbi_pair_is_far(const sbi_pair_search *search, int other, sb_real most)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    sb_vec3 way = sb_v3_sub(search->at, pairs->middles[other]);
    sb_real reach = pairs->radii[other] + most;
    return sb_v3_dot(way, way) > reach * reach;
}

/* How far a partner of this face may be, whichever way it leans (m). */
static sb_real sbi_pair_farthest(const sb_contact *contact, int other, sb_real length)
{
    const sbi_pairs *pairs = &contact->pairs;
    sb_real height = sb_max(sbi_pair_deepest(pairs, other), sbi_pairs_highest(contact, other));
    return (1 + SBI_PAIR_LEAN) * height + SBI_PAIR_BESIDE * length;
}

/* 1 when the sample lies in the organ of this face where the step begins. What an organ overlaps itself by is not seen
 * so. */
static int sbi_pair_is_within(sbi_pair_search *search, int other)
{
    int organ = search->contact->pairs.organs[other];
    if (organ == search->contact->pairs.organs[search->face])
        return 1;
    if (organ != search->within_organ)
        search->within = sbi_pairs_is_within(search->contact, organ, search->at, search->contact->x, NULL);
    search->within_organ = organ;
    return search->within;
}

/* A face near the sample where the step begins. */
static void sbi_pair_try_near(sbi_pair_search *search, int other)
{
    sb_contact *contact = search->contact;
    const sbi_pairs *pairs = &contact->pairs;
    sb_vec3 x[SB_MAX_FACE_NODES], way, n = sbi_pairs_face_normal(contact, other);
    sbi_closest closest;
    sb_real height, beside, length = contact->faces->lengths[other], away, lean;
    sb_real most = sbi_pair_farthest(contact, other, length);
    if (sbi_pair_is_far(search, other, search->best >= 0 ? sb_min(most, search->measure) : most))
        return;
    sbi_pair_gather(contact, other, x);
    sbi_closest_on_face(&contact->faces->kinds[contact->faces->sizes[other]], x, search->at, &closest);
    way = sb_v3_sub(search->at, closest.point);
    height = sb_v3_dot(n, way);
    away = sb_v3_norm(way);
    beside = sb_v3_norm(sbi_contact_tangential(way, n));
    if (search->nearest < 0 || away < search->nearest_away) {
        search->nearest = other;
        search->nearest_away = away;
        search->nearest_height = height;
    }
    if (!(-height > SBI_PAIR_DEEP * length) && !sbi_pairs_face(contact, search->face, other))
        return;
    lean = height > 0 ? SBI_PAIR_LEAN : SBI_PAIR_LEAN_INSIDE;
    if (height > sbi_pairs_highest(contact, other) || -height > sbi_pair_deepest(pairs, other) ||
        beside > lean * sb_abs(height) + SBI_PAIR_BESIDE * length || (search->best >= 0 && !(away < search->measure)) ||
        (-height > SBI_PAIR_DEEP * length &&
         (!sbi_pair_is_within(search, other) ||
          !sbi_pairs_is_inside(contact, search->face, other, search->at, -SBI_PAIR_SIDE * height, contact->x, NULL))))
        return;
    search->best = other;
    search->measure = away;
    search->closest = closest;
}

/* A face that the sample will come to on its way. */
static void sbi_pair_try_way(sbi_pair_search *search, int other)
{
    const sb_contact *contact = search->contact;
    const sbi_contact_kind *kind = &contact->faces->kinds[contact->faces->sizes[other]];
    const int *nodes = sbi_contact_face_nodes(contact->faces, other);
    const sb_vec3 against = sb_v3_sub(search->way, contact->pairs.ways[other]);
    sb_vec3 x[SB_MAX_FACE_NODES], v[SB_MAX_FACE_NODES];
    const sb_real most = sb_v3_norm(against) + contact->pairs.spreads[other];
    if (!sbi_pairs_face(contact, search->face, other) || sbi_pairs_is_above(contact, other, search->at, most) ||
        sbi_pair_is_far(search, other, most))
        return;
    sbi_pair_gather(contact, other, x);
    for (int a = 0; a < kind->nodes; a++)
        v[a] = sb_v3_scale(search->step->dt, search->step->velocity[nodes[a]]);
    for (int part = 0; part < sbi_closest_part_count(kind); part++) {
        sb_vec3 at[3], ways[3];
        sb_real share, depth;
        for (int k = 0; k < 3; k++) {
            at[k] = x[sbi_closest_part_node(kind, part, k)];
            ways[k] = v[sbi_closest_part_node(kind, part, k)];
        }
        share = sbi_closest_meeting(at, ways, search->at, search->way, &depth);
        if (share < 0 || (search->best >= 0 && !(share < search->measure)))
            continue;
        search->best = other;
        search->measure = share;
        for (int a = 0; a < kind->nodes; a++)
            v[a] = sb_v3_madd(x[a], share, v[a]);
        sbi_closest_on_face(kind, v, sb_v3_madd(search->at, share, search->way), &search->closest);
        return;
    }
}

/* A sample that no face's own rule holds may lie in a fold of the other organ, nearest to an edge or a corner there, or
 * to a face that does not look at it: the nearest of all faces decides. */
static void sbi_pair_try_around(sbi_pair_search *search)
{
    sb_contact *contact = search->contact;
    const sbi_contact_faces *faces = contact->faces;
    sbi_pairs *pairs = &contact->pairs;
    sb_vec3 at = search->at, sum = {0, 0, 0}, own = sbi_pairs_face_normal(contact, search->face);
    sb_real most = search->nearest_away * (1 + SBI_PAIR_BESIDE), least = SB_REAL_MAX;
    int organ = pairs->organs[search->nearest], best = -1, count;
    count = sbi_contact_faces_query(contact->faces, sb_v3(at.x - most, at.y - most, at.z - most),
                                    sb_v3(at.x + most, at.y + most, at.z + most), contact->scratch, faces->face_room);
    for (int pass = 0; pass < 2; pass++)
        for (int i = 0; i < count; i++) {
            int other = contact->scratch[i];
            sb_vec3 x[SB_MAX_FACE_NODES];
            sbi_closest closest;
            sb_real away;
            if (pairs->organs[other] != organ || !sbi_pairs_are_apart(contact, search->face, other))
                continue;
            sbi_pair_gather(contact, other, x);
            sbi_closest_on_face(&faces->kinds[faces->sizes[other]], x, at, &closest);
            away = sb_v3_norm(sb_v3_sub(at, closest.point));
            if (pass == 0 && away < least)
                least = away, best = other, search->closest = closest;
            if (pass == 1 && away <= least * (1 + SBI_PAIR_BESIDE)) /* those of its edge or corner */
                sum = sb_v3_add(sum, sbi_pairs_face_normal(contact, other));
        }
    if (best < 0 ||
        !(sb_v3_dot(sum, sb_v3_sub(at, search->closest.point)) < -SBI_PAIR_TURNED * sb_v3_norm(sum) * least) ||
        !(sb_v3_dot(sum, own) < SBI_PAIR_TURNED * sb_v3_norm(sum)) || least > sbi_pair_deepest(pairs, best) ||
        !sbi_pair_is_within(search, best))
        return;
    search->best = best;
}

/* The face whose middle is nearest: most others are then known to be farther. -1: none is. */
static int sbi_pair_guess(const sbi_pair_search *search)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    const int *guesses = pairs->lists[SBI_PAIR_GUESSES];
    sb_real least = SB_REAL_MAX;
    int best = -1;
    for (int i = 0; i < pairs->list_counts[SBI_PAIR_GUESSES]; i++) {
        sb_vec3 way = sb_v3_sub(search->at, pairs->middles[guesses[i]]);
        sb_real square = sb_v3_dot(way, way);
        if (square < least)
            least = square, best = guesses[i];
    }
    return best;
}

/* 1 when a flat face is no nearer than what holds the sample: by how high that is above its plane, and the square of
 * how far it is beside its middle. */
static int sbi_pair_is_no_nearer(const sbi_pair_search *search, int other, sb_real height, sb_real beside)
{
    sb_real most = search->measure + SBI_PAIR_BESIDE * search->contact->faces->lengths[other];
    sb_real reach = most * most - height * height;
    if (reach < 0)
        return 1;
    reach = search->contact->pairs.radii[other] + sb_sqrt(reach);
    return beside > reach * reach;
}

/* 1 when a flat face's own rule cannot hold the sample, or no better than what does: by how high it is above the plane
 * (lower: behind) and how far beside the face. */
static int sbi_pair_is_useless(const sbi_pair_search *search, int other)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    sb_vec3 way = sb_v3_sub(search->at, pairs->middles[other]);
    sb_real height = sb_v3_dot(pairs->normals[other], way), beside = sb_v3_dot(way, way) - height * height, reach;
    sb_real rounded = 2 * SBI_PAIR_BESIDE * search->contact->faces->lengths[other];
    reach = pairs->radii[other] + (height > 0 ? SBI_PAIR_LEAN : SBI_PAIR_LEAN_INSIDE) * sb_abs(height) + rounded;
    return beside > reach * reach || height > sbi_pairs_highest(search->contact, other) + rounded ||
           -height > sbi_pair_deepest(pairs, other) + rounded ||
           (search->best >= 0 && sbi_pair_is_no_nearer(search, other, height, beside));
}

/* The nearest face is no farther than this (m): as far as one is known to be that counts. */
static sb_real sbi_pair_nearest_at_most(const sbi_pair_search *search, int first)
{
    const sb_contact *contact = search->contact;
    if (search->nearest >= 0)
        return search->nearest_away;
    if (first < 0 || sbi_pair_is_far(search, first, sbi_pair_farthest(contact, first, contact->faces->lengths[first])))
        return SB_REAL_MAX;
    return sb_v3_norm(sb_v3_sub(search->at, contact->pairs.middles[first]));
}

/* 1 when the sample may lie straight behind a flat face, no farther than that. */
static int sbi_pair_may_be_behind(const sbi_pair_search *search, int other, sb_real most)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    sb_vec3 x[SB_MAX_FACE_NODES], way = sb_v3_sub(search->at, pairs->middles[other]);
    sb_real height = sb_v3_dot(pairs->normals[other], way), beside = sb_v3_dot(way, way) - height * height;
    sb_real rounded = 2 * SBI_PAIR_BESIDE * search->contact->faces->lengths[other];
    sb_real reach = pairs->radii[other] - SBI_PAIR_SLANTED * height + rounded;
    sbi_closest closest;
    if (!(height < 0) || -height > most + rounded || pairs->organs[other] == pairs->organs[search->face] ||
        beside > reach * reach)
        return 0;
    sbi_pair_gather(search->contact, other, x);
    sbi_closest_on_face(&search->contact->faces->kinds[3], x, search->at, &closest);
    reach = sb_v3_norm(sb_v3_sub(search->at, closest.point));
    return reach < most + rounded && SBI_PAIR_TURNED * reach < rounded - height;
}

/* Tries those others that may hold the sample, or every one, since they may be nearer; one of them first. */
static void sbi_pair_try_others(sbi_pair_search *search, int first, int every)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    const int *others = every ? pairs->found : pairs->lists[SBI_PAIR_HOLDERS];
    int count = every ? search->others : pairs->list_counts[SBI_PAIR_HOLDERS];
    search->best = search->nearest = -1;
    if (first >= 0 && (every || !sbi_pair_is_useless(search, first)))
        sbi_pair_try_near(search, first);
    for (int i = 0; i < count; i++)
        if (others[i] != first && (every || !sbi_pair_is_useless(search, others[i])))
            sbi_pair_try_near(search, others[i]);
}

/* 1 when the nearest face of another organ is behind the sample; else that is beside it. */
static int sbi_pair_is_behind(const sbi_pair_search *search)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    return search->best < 0 && search->nearest >= 0 && pairs->organs[search->nearest] != pairs->organs[search->face] &&
           search->nearest_height < -SBI_PAIR_TURNED * search->nearest_away;
}

/* 1 when the sample may lie straight behind some face, no farther than the nearest is: all are to be looked at. */
static int sbi_pair_is_behind_any(const sbi_pair_search *search, int first)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    sb_real most = sbi_pair_nearest_at_most(search, first);
    int i = 0, count = pairs->list_counts[SBI_PAIR_BACKS];
    while (i < count && !sbi_pair_may_be_behind(search, pairs->lists[SBI_PAIR_BACKS][i], most))
        i++;
    return i < count;
}

static void sbi_pair_look(sbi_pair_search *search)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    int first = sbi_pair_guess(search), every = search->contact->faces->tree.size != 3;
    search->within_organ = -1;
    sbi_pair_try_others(search, first, every);
    if (!every && search->best < 0 && sbi_pair_is_behind_any(search, first)) {
        every = 1;
        sbi_pair_try_others(search, first, 1);
    }
    if (every && sbi_pair_is_behind(search))
        sbi_pair_try_around(search);
    for (int i = 0; search->best < 0 && i < pairs->list_counts[SBI_PAIR_COMERS]; i++)
        sbi_pair_try_way(search, pairs->lists[SBI_PAIR_COMERS][i]);
}

/* Which lists a face is in, as bits: by the ball around the face whose samples are to be paired. nearest: how near a
 * middle is to the ball's at least (m). */
static int sbi_pair_lists_of(const sbi_pair_search *search, int other, sb_real nearest)
{
    const sb_contact *contact = search->contact;
    const sbi_pairs *pairs = &contact->pairs;
    sb_vec3 way = sb_v3_sub(pairs->middles[search->face], pairs->middles[other]);
    sb_real square = sb_v3_dot(way, way), height = sb_v3_dot(pairs->normals[other], way), ball, low, high, reach;
    sb_real rounded = 3 * SBI_PAIR_BESIDE * contact->faces->lengths[other], most, closing;
    int flat = contact->faces->tree.size == 3, lists = 0;
    ball = pairs->radii[search->face], low = height - ball - rounded, high = height + ball + rounded;
    most = nearest + 2 * ball + rounded;
    if (square <= most * most)
        lists |= 1 << SBI_PAIR_GUESSES;
    most = sbi_pairs_highest(contact, other);
    reach = pairs->radii[other] + ball + rounded + SBI_PAIR_LEAN * sb_max((sb_real)0, sb_min(high, most)) +
            SBI_PAIR_LEAN_INSIDE * sb_max((sb_real)0, -low);
    if (!flat || (low <= most && -high <= sbi_pair_deepest(pairs, other) && square - height * height <= reach * reach))
        lists |= 1 << SBI_PAIR_HOLDERS;
    if (!flat || low < 0)
        lists |= 1 << SBI_PAIR_BACKS;
    closing = sbi_pairs_closing(contact, search->face, other);
    reach = pairs->radii[other] + ball + closing + rounded;
    if (search->step->dt > 0 && square <= reach * reach && (!flat || low <= closing) &&
        sbi_pairs_face(contact, search->face, other))
        lists |= 1 << SBI_PAIR_COMERS;
    return lists;
}

/* Lists what the face's samples need to look at, of what was found. */
static void sbi_pair_list_others(sbi_pair_search *search)
{
    sbi_pairs *pairs = &search->contact->pairs;
    sb_real least = SB_REAL_MAX;
    memset(pairs->list_counts, 0, sizeof pairs->list_counts);
    for (int i = 0; i < search->others; i++) {
        sb_vec3 way = sb_v3_sub(pairs->middles[search->face], pairs->middles[pairs->found[i]]);
        least = sb_min(least, sb_v3_dot(way, way));
    }
    least = sb_sqrt(least);
    for (int i = 0; i < search->others; i++) {
        int lists = sbi_pair_lists_of(search, pairs->found[i], least);
        for (int list = 0; list < SBI_PAIR_LISTS; list++)
            if (lists >> list & 1)
                pairs->lists[list][pairs->list_counts[list]++] = pairs->found[i];
    }
}

static int sbi_pair_take_slot(sbi_pairs *pairs, int face)
{
    if (pairs->slot_of[face] >= 0)
        return 1;
    if (pairs->slot_count == pairs->slot_room)
        return 0;
    pairs->slot_of[face] = pairs->slot_count;
    pairs->slots[pairs->slot_count++] = face;
    return 1;
}

/* Where the smooth normal does not lead out of the other organ, the way to the nearest point does: of overlap that is
 * deep. At rest the way is what rounding makes of it. */
static void sbi_pair_turn_out(sbi_pair_sample *s, sb_real length)
{
    sb_real away = sb_v3_norm(s->start), height = sb_v3_dot(s->normal, s->start);
    if (height < 0 && -height < SBI_PAIR_TURNED * away && away > SBI_PAIR_DEEP * length)
        s->normal = sb_v3_scale(-1 / away, s->start);
}

/* How deep it would be at the end if nothing held it, of what is safe. */
static void sbi_pair_foresee(const sbi_pair_search *search, const sbi_pair_sample *s)
{
    sb_contact *contact = search->contact;
    const int *nodes = sbi_contact_face_nodes(contact->faces, s->other);
    sb_vec3 other = sbi_contact_mean(s->shares, nodes, contact->faces->sizes[s->other], search->step->velocity);
    sb_vec3 end = sb_v3_add(s->start, sb_v3_madd(search->way, -search->step->dt, other));
    sb_real depth = -sb_v3_dot(s->normal, end), closer = depth + sb_min((sb_real)0, sb_v3_dot(s->normal, s->start));
    sb_real most = SBI_PAIR_COASTS * sbi_pairs_safe_depth(contact, s->other);
    contact->pairs.foreseen = sb_max(contact->pairs.foreseen, closer / most);
}

/* The sample of the patch that is being made, with its partner. 0: no room is left. */
static int sbi_pair_add_sample(const sbi_pair_search *search, int number, const sb_real *weights)
{
    sb_contact *contact = search->contact;
    sbi_pairs *pairs = &contact->pairs;
    const int *nodes = sbi_contact_face_nodes(contact->faces, search->best);
    int count = contact->faces->sizes[search->best];
    sbi_pair_sample *s = pairs->samples + pairs->sample_count;
    if (pairs->sample_count == contact->max_contacts || !sbi_pair_take_slot(pairs, search->face) ||
        !sbi_pair_take_slot(pairs, search->best))
        return 0;
    memset(s, 0, sizeof *s);
    s->patch = pairs->patch_count;
    s->face = search->face;
    s->sample = number;
    s->weights = weights;
    s->other = search->best;
    for (int a = 0; a < count; a++) {
        s->shares[a] = search->closest.shares[a];
        s->other_nodes[a] = sbi_contact_place_node(contact, nodes[a]);
    }
    s->normal = sbi_pairs_normal(contact, search->best, search->closest.shares);
    s->start = sb_v3_sub(search->at, sbi_contact_mean(s->shares, nodes, count, contact->x));
    sbi_pair_turn_out(s, contact->faces->lengths[search->best]);
    sbi_pair_foresee(search, s);
    pairs->sample_count++;
    return 1;
}

/* The samples of a face that have a partner. 0: no room is left. */
static int sbi_pair_add_patch(sb_contact *contact, const sbi_touch_step *step, int face, int thin)
{
    sbi_pairs *pairs = &contact->pairs;
    const sbi_contact_faces *faces = contact->faces;
    const int *nodes = sbi_contact_face_nodes(faces, face);
    sbi_pair_patch *patch = pairs->patches + pairs->patch_count;
    int parts = sbi_pairs_parts(contact, face, thin), count = faces->sizes[face];
    const sbi_contact_rule *rule = sbi_contact_face_rule(faces, face, parts);
    sbi_pair_search search;
    if (pairs->patch_count == contact->patch_room)
        return 0;
    memset(patch, 0, sizeof *patch);
    patch->first = pairs->sample_count;
    memset(&search, 0, sizeof search);
    search.contact = contact;
    search.step = step;
    search.face = face;
    search.others = sbi_pairs_find_others(contact, face, contact->x, step->velocity, step->dt, pairs->reach);
    sbi_pair_list_others(&search);
    for (int i = 0; search.others > 0 && i < rule->count; i++) {
        const sb_real *weights = rule->weights + (size_t)i * (size_t)count;
        search.at = sbi_contact_mean(weights, nodes, count, contact->x);
        search.way = sb_v3_scale(step->dt, sbi_contact_mean(weights, nodes, count, step->velocity));
        sbi_pair_look(&search);
        if (search.best >= 0 && !sbi_pair_add_sample(&search, i, weights))
            return 0;
    }
    patch->count = pairs->sample_count - patch->first;
    if (patch->count == 0)
        return 1;
    patch->face = face;
    patch->parts = parts;
    for (int a = 0; a < count; a++)
        patch->nodes[a] = sbi_contact_place_node(contact, nodes[a]);
    for (int i = patch->first; i < pairs->sample_count; i++) {
        sbi_pair_sample *s = pairs->samples + i;
        sb_real area = sbi_contact_sample_area(faces, contact->body, face, parts, s->sample);
        s->area = area / 2;
        s->spacing = sb_sqrt(area);
    }
    pairs->patch_count++;
    return 1;
}

SBI_API void sbi_pairs_forget(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    for (int i = 0; i < pairs->slot_count; i++)
        pairs->slot_of[pairs->slots[i]] = -1;
    pairs->slot_count = pairs->patch_count = pairs->sample_count = pairs->active_count = 0;
    pairs->foreseen = 0;
}

/* Takes back nodes from `count` on. */
static void sbi_pair_return_nodes(sb_contact *contact, int count)
{
    while (contact->node_count > count)
        contact->node_place[contact->nodes[--contact->node_count]] = -1;
}

/* A step in which organs go so far that pairs of its start mean nothing is left for shorter ones. */
static sb_result sbi_pair_check_way(sb_contact *contact, const sbi_touch_step *step, sb_error *error)
{
    sb_real parts = contact->pairs.foreseen;
    if (!(parts > 1) || contact->touch.is_last || !(step->dt > 0))
        return SB_OK;
    contact->touch.apart = 1;
    contact->touch.parts = parts < (sb_real)SBI_PAIR_MOST_PARTS ? (int)parts + 1 : SBI_PAIR_MOST_PARTS;
    return sbi_fail(error, SB_ERROR_DIVERGED, "organs move so far in this step that they may pass through each other");
}

SBI_API sb_result sbi_pairs_begin(sb_contact *contact, const sbi_touch_step *step, sb_error *error)
{
    sbi_pairs *pairs = &contact->pairs;
    int nodes = contact->node_count;
    contact->touch.links = 0;
    pairs->link_count = pairs->saved_count = 0;
    pairs->zones_made = SBI_ZONES_NONE;
    if (!pairs->kinds)
        return SB_OK;
    pairs->reach = sb_max(pairs->longest, pairs->distance);
    sbi_pairs_look(contact, contact->x);
    sbi_pairs_follow(contact, step->velocity, step->dt);
    sbi_pairs_find_near(contact, pairs->reach, contact->x);
    for (int thin = 0;; thin++) {
        int face = sbi_pairs_next_near(contact, 0);
        sbi_pairs_forget(contact);
        sbi_pair_return_nodes(contact, nodes);
        while (face >= 0 && sbi_pair_add_patch(contact, step, face, thin))
            face = sbi_pairs_next_near(contact, face + 1);
        contact->step_info.thinned |= thin > 0;
        if (face < 0)
            return sbi_pair_check_way(contact, step, error);
        if (thin == SBI_PAIR_THINNEST)
            return sbi_fail(error, SB_ERROR_MEMORY, "more than max_contacts = %d samples of organs are near each other",
                            contact->max_contacts);
    }
}

/* ---- stiffness ---- */

/* Mean of what the nodes of a region's faces in pairs have: one number for a region, so that organs pressed together
 * evenly have the same pressure everywhere. */
static void sbi_pair_measure_regions(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    memset(pairs->region_sum, 0, (size_t)contact->region_room * sizeof(sb_real));
    memset(pairs->region_count, 0, (size_t)contact->region_room * sizeof(int));
    for (int i = 0; i < pairs->slot_count; i++) {
        const int *nodes = sbi_contact_face_nodes(contact->faces, pairs->slots[i]);
        int region = contact->faces->regions[pairs->slots[i]];
        for (int a = 0; a < contact->faces->sizes[pairs->slots[i]]; a++) {
            int place = contact->node_place[nodes[a]];
            if (place >= 0 && contact->stiffness_by_node[place] > 0) {
                pairs->region_sum[region] += contact->stiffness_by_node[place];
                pairs->region_count[region]++;
            }
        }
    }
    for (int r = 0; r < contact->region_room; r++)
        if (pairs->region_count[r] > 0)
            pairs->region_sum[r] /= (sb_real)pairs->region_count[r];
}

SBI_API void sbi_pairs_stiffen(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    if (pairs->sample_count == 0)
        return;
    sbi_pair_measure_regions(contact);
    for (int i = 0; i < pairs->sample_count; i++) {
        sbi_pair_sample *s = pairs->samples + i;
        sb_real one = pairs->region_sum[contact->faces->regions[pairs->patches[s->patch].face]];
        sb_real two = pairs->region_sum[contact->faces->regions[s->other]];
        s->k = one > 0 && two > 0 ? SBI_PAIR_STIFFNESS * 2 * one * (two / (one + two)) : 0;
    }
}

SBI_API double sbi_pairs_noise_square(const sb_contact *contact, double place)
{
    double sum = 0;
    for (int i = 0; i < contact->pairs.sample_count; i++) {
        const sbi_pair_sample *s = contact->pairs.samples + i;
        double force = (double)(s->area * s->k) * (double)SB_EPSILON * place;
        sum += 2 * force * force;
    }
    return sum;
}

/* ---- evaluation ---- */

typedef struct sbi_pair_work {
    sb_contact *contact;
    const sb_vec3 *du;
    int renew;
} sbi_pair_work;

static void sbi_pair_evaluate_sample(const sbi_pair_work *work, sbi_pair_sample *s)
{
    const sb_contact *contact = work->contact;
    const sbi_pairs *pairs = &contact->pairs;
    const int *nodes = pairs->patches[s->patch].nodes;
    int count = contact->faces->sizes[s->face];
    sb_vec3 one = sbi_contact_mean(s->weights, nodes, count, work->du), motion;
    motion = sb_v3_sub(one, sbi_contact_mean(s->shares, s->other_nodes, contact->faces->sizes[s->other], work->du));
    s->point = sb_v3_add(sbi_contact_mean(s->weights, nodes, count, contact->positions), one);
    s->gap = sb_v3_dot(s->normal, sb_v3_add(s->start, motion)) - pairs->distance;
    s->slip = sb_v3_norm(sbi_contact_tangential(motion, s->normal));
    if (work->renew)
        s->bound = pairs->friction * sb_max((sb_real)0, s->memory - s->k * (s->gap - s->left));
    s->answer = sbi_contact_law(s->k, s->gap - s->left, s->memory, s->normal, motion, s->remembered, s->bound);
}

static void sbi_pair_evaluate_chunk(void *user, int chunk)
{
    const sbi_pair_work *work = (const sbi_pair_work *)user;
    sbi_pairs *pairs = &work->contact->pairs;
    int last = sbi_min_int((chunk + 1) * SBI_PAIR_CHUNK, pairs->sample_count);
    for (int i = chunk * SBI_PAIR_CHUNK; i < last; i++)
        sbi_pair_evaluate_sample(work, pairs->samples + i);
}

SB_INLINE sb_vec3 sbi_pair_force(const sbi_pair_sample *s)
{
    return sb_v3_scale(s->area, sb_v3_madd(s->answer.traction, s->answer.pressure, s->normal));
}

/* Adds f to one side's nodes and takes it from the other's. */
static void sbi_pair_scatter(const sb_contact *contact, const sbi_pair_sample *s, sb_vec3 f, sb_vec3 *out)
{
    const sbi_pair_patch *patch = contact->pairs.patches + s->patch;
    for (int a = 0; a < contact->faces->sizes[patch->face]; a++)
        out[patch->nodes[a]] = sb_v3_madd(out[patch->nodes[a]], s->weights[a], f);
    for (int a = 0; a < contact->faces->sizes[s->other]; a++)
        out[s->other_nodes[a]] = sb_v3_madd(out[s->other_nodes[a]], -s->shares[a], f);
}

SBI_API void sbi_pairs_evaluate(sb_contact *contact, const sb_vec3 *du, int renew)
{
    sbi_pairs *pairs = &contact->pairs;
    int chunks = pairs->sample_count / SBI_PAIR_CHUNK + (pairs->sample_count % SBI_PAIR_CHUNK != 0);
    sbi_pair_work work;
    work.contact = contact;
    work.du = du;
    work.renew = renew;
    sbi_run(sbi_body_jobs(contact->body), sbi_pair_evaluate_chunk, &work, chunks);
    pairs->active_count = 0;
    for (int i = 0; i < pairs->sample_count; i++)
        if (pairs->samples[i].answer.state != SBI_CONTACT_OFF)
            pairs->active[pairs->active_count++] = i;
}

SBI_API void sbi_pairs_add_forces(sb_contact *contact, sb_vec3 *force)
{
    const sbi_pairs *pairs = &contact->pairs;
    for (int i = 0; i < pairs->active_count; i++) {
        const sbi_pair_sample *s = pairs->samples + pairs->active[i];
        sbi_pair_scatter(contact, s, sbi_pair_force(s), force);
    }
    contact->touch.touching += pairs->active_count;
}

/* ---- stiffness of the system ---- */

static sb_vec3 sbi_pair_times(const sbi_pair_link *link, sb_vec3 v)
{
    sb_vec3 out = sb_v3_scale(link->tangent, v);
    out = sb_v3_madd(out, (link->normal - link->tangent) * sb_v3_dot(link->n, v), link->n);
    return sb_v3_madd(out, -link->tangent * sb_v3_dot(link->d, v), link->d);
}

static sbi_pair_link sbi_pair_make_link(const sbi_pairs *pairs, int sample)
{
    const sbi_pair_sample *s = pairs->samples + sample;
    sbi_pair_link link;
    link.sample = sample;
    link.normal = s->area * s->answer.normal;
    link.tangent = s->area * s->answer.tangent;
    link.n = s->normal;
    link.d = s->answer.direction;
    return link;
}

SBI_API void sbi_pairs_multiply(const sb_contact *contact, const unsigned char *masked, const sb_vec3 *x, sb_vec3 *out)
{
    const sbi_pairs *pairs = &contact->pairs;
    for (int i = 0; i < pairs->active_count; i++) {
        const sbi_pair_sample *s = pairs->samples + pairs->active[i];
        const sbi_pair_patch *patch = pairs->patches + s->patch;
        sbi_pair_link link = sbi_pair_make_link(pairs, pairs->active[i]);
        sb_vec3 way = {0, 0, 0};
        for (int a = 0; a < contact->faces->sizes[patch->face]; a++) {
            int place = patch->nodes[a];
            unsigned axes = masked ? masked[contact->nodes[place]] : 0u;
            way = sb_v3_madd(way, s->weights[a], sbi_contact_unmasked(axes, x[place]));
        }
        for (int a = 0; a < contact->faces->sizes[s->other]; a++) {
            int place = s->other_nodes[a];
            unsigned axes = masked ? masked[contact->nodes[place]] : 0u;
            way = sb_v3_madd(way, -s->shares[a], sbi_contact_unmasked(axes, x[place]));
        }
        sbi_pair_scatter(contact, s, sbi_pair_times(&link, way), out);
    }
}

/* A face's blocks += factor^2 K of a sample with these weights of its nodes. */
static void sbi_pair_sum_blocks(sb_contact *contact, int face, const sb_real *weights, const sb_real *k)
{
    size_t width = (size_t)contact->faces->width;
    sb_real(*blocks)[9] = contact->pairs.blocks + (size_t)contact->pairs.slot_of[face] * width * width;
    int count = contact->faces->sizes[face];
    for (int a = 0; a < count; a++)
        for (int b = 0; b < count; b++)
            for (int c = 0; c < 9; c++)
                blocks[a * count + b][c] += weights[a] * weights[b] * k[c];
}

static void sbi_pair_make_blocks(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    size_t width = (size_t)contact->faces->width;
    memset(pairs->blocks, 0, (size_t)pairs->slot_count * width * width * sizeof *pairs->blocks);
    for (int i = 0; i < pairs->active_count; i++) {
        const sbi_pair_sample *s = pairs->samples + pairs->active[i];
        sb_real k[9];
        sbi_contact_stiffness(&s->answer, s->normal, s->area, k);
        sbi_pair_sum_blocks(contact, pairs->patches[s->patch].face, s->weights, k);
        sbi_pair_sum_blocks(contact, s->other, s->shares, k);
    }
}

static void sbi_pair_add_slot(sb_contact *contact, int slot, const unsigned char *masked, sb_matrix *matrix)
{
    sbi_pairs *pairs = &contact->pairs;
    size_t width = (size_t)contact->faces->width;
    int face = pairs->slots[slot], count = contact->faces->sizes[face];
    const int *nodes = sbi_contact_face_nodes(contact->faces, face);
    const int *places = sbi_contact_face_blocks(contact->faces, contact->body, face);
    const sb_real(*blocks)[9] = (const sb_real(*)[9])(pairs->blocks + (size_t)slot * width * width);
    for (int i = 0; i < count * count; i++) {
        sbi_contact_saved *saved = pairs->saved + pairs->saved_count++;
        unsigned rows = masked ? masked[nodes[i / count]] : 0u, columns = masked ? masked[nodes[i % count]] : 0u;
        saved->block = places[i];
        memcpy(saved->values, matrix->blocks[places[i]], sizeof saved->values);
        sbi_contact_add_block(matrix->blocks[places[i]], blocks[i], rows, columns);
    }
}

SBI_API void sbi_pairs_add_blocks(sb_contact *contact, const unsigned char *masked, sb_matrix *matrix)
{
    sbi_pairs *pairs = &contact->pairs;
    pairs->saved_count = pairs->link_count = 0;
    contact->touch.links = pairs->active_count > 0;
    if (pairs->active_count == 0)
        return;
    sbi_pair_make_blocks(contact);
    for (int slot = 0; slot < pairs->slot_count; slot++)
        sbi_pair_add_slot(contact, slot, masked, matrix);
    for (int i = 0; i < pairs->active_count; i++)
        pairs->links[pairs->link_count++] = sbi_pair_make_link(pairs, pairs->active[i]);
}

SBI_API void sbi_pairs_restore_blocks(sb_contact *contact, sb_matrix *matrix)
{
    sbi_pairs *pairs = &contact->pairs;
    while (pairs->saved_count > 0) { /* backwards, since faces share blocks */
        const sbi_contact_saved *saved = pairs->saved + --pairs->saved_count;
        memcpy(matrix->blocks[saved->block], saved->values, sizeof saved->values);
    }
}

/* Mean of x [rows] with weights of nodes, without masked axes. */
static sb_vec3 sbi_pair_mean(const int *nodes, const sb_real *weights, int count, const unsigned char *masked,
                             const sb_vec3 *x)
{
    sb_vec3 sum = {0, 0, 0};
    for (int a = 0; a < count; a++)
        sum = sb_v3_madd(sum, weights[a], sbi_contact_unmasked(masked ? masked[nodes[a]] : 0u, x[nodes[a]]));
    return sum;
}

static void sbi_pair_subtract(const int *nodes, const sb_real *weights, int count, const unsigned char *masked,
                              sb_vec3 f, sb_vec3 *out)
{
    for (int a = 0; a < count; a++)
        out[nodes[a]] = sb_v3_madd(out[nodes[a]], -weights[a], sbi_contact_unmasked(masked ? masked[nodes[a]] : 0u, f));
}

SBI_API double sbi_pairs_multiply_links(void *user, const unsigned char *masked, const sb_vec3 *x, sb_vec3 *out)
{
    const sb_contact *contact = (const sb_contact *)user;
    const sbi_pairs *pairs = &contact->pairs;
    double sum = 0;
    for (int i = 0; i < pairs->link_count; i++) {
        const sbi_pair_link *link = pairs->links + i;
        const sbi_pair_sample *s = pairs->samples + link->sample;
        int face = s->face, count = contact->faces->sizes[face], others = contact->faces->sizes[s->other];
        const int *one = sbi_contact_face_nodes(contact->faces, face);
        const int *two = sbi_contact_face_nodes(contact->faces, s->other);
        sb_vec3 x1 = sbi_pair_mean(one, s->weights, count, masked, x);
        sb_vec3 x2 = sbi_pair_mean(two, s->shares, others, masked, x);
        sb_vec3 f1 = sbi_pair_times(link, x2);
        sbi_pair_subtract(one, s->weights, count, masked, f1, out);
        sbi_pair_subtract(two, s->shares, others, masked, sbi_pair_times(link, x1), out);
        sum -= 2 * (double)sb_v3_dot(x1, f1);
    }
    return sum;
}
