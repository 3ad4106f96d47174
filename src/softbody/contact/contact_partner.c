/* contact_partner: which point of another face a sample is paired with for a step: the nearest of those that its face
 * looks at and that its rules let hold it, or the first that it comes to on its way.
 *
 * A face lists once what its samples need to look at, as balls; each sample begins with what the one before it found,
 * since that leaves little that may be nearer. */
#include <string.h>

#include "contact_private.h"

/* Of its depth: where a face of any look is nearer than that, a sample is not held by this one. */
#define SBI_PARTNER_SIDE ((sb_real)0.9)
/* More than rounding makes of lengths. */
#define SBI_PARTNER_LOOSE ((sb_real)1.001)

static void sbi_partner_gather(const sb_contact *contact, int face, sb_vec3 *x)
{
    const int *nodes = sbi_contact_face_nodes(contact->faces, face);
    for (int a = 0; a < contact->faces->sizes[face]; a++)
        x[a] = contact->x[nodes[a]];
}

/* 1 when no point of a face is within `most` (m) of the sample where the step begins. */
static int sbi_partner_is_far(const sbi_pair_search *search, int other, sb_real most)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    sb_vec3 way = sb_v3_sub(search->at, pairs->plates[other].middle);
    sb_real reach = pairs->plates[other].radius + most;
    return sb_v3_dot(way, way) > reach * reach;
}

/* What a sample at a place is to a face of list `number`. */
SB_INLINE sbi_pair_pick sbi_partner_pick(const sbi_pair_ball *ball, int number, sb_vec3 at)
{
    const sb_vec3 way = sb_v3_sub(at, ball->plate.middle);
    sbi_pair_pick pick;
    pick.number = number;
    pick.height = sb_v3_dot(ball->plate.normal, way);
    pick.square = sb_v3_dot(way, way);
    pick.beside = pick.square - pick.height * pick.height;
    return pick;
}

static int sbi_partner_is_out_of(const sbi_pair_ball *ball, const sbi_pair_pick *pick, sb_real most)
{
    const sb_real reach = ball->plate.radius + most;
    return pick->square > reach * reach;
}

/* Lengths that rounding does not reach (m). */
static sb_real sbi_partner_rounded(const sbi_pair_search *search, int other)
{
    return 2 * SBI_PAIR_BESIDE * search->contact->faces->lengths[other];
}

/* How far a partner of this face may be, whichever way it leans (m). */
static sb_real sbi_partner_farthest(const sb_contact *contact, int other)
{
    sb_real height = sb_max(sbi_pairs_deepest(contact, other), sbi_pairs_highest_ever(contact, other));
    return (1 + SBI_PAIR_LEAN) * height + SBI_PAIR_BESIDE * contact->faces->lengths[other];
}

static sbi_pair_ball sbi_partner_make_ball(const sbi_pair_search *search, int other, sb_real highest)
{
    const sb_contact *contact = search->contact;
    const sbi_pairs *pairs = &contact->pairs;
    sbi_pair_ball ball;
    ball.plate = pairs->plates[other];
    ball.most = sbi_partner_farthest(contact, other);
    ball.highest = highest;
    ball.deepest = sbi_pairs_deepest(contact, other);
    ball.goes = sb_v3_norm(pairs->ways[other]) + pairs->spreads[other];
    ball.rounded = sbi_partner_rounded(search, other);
    ball.face = other;
    return ball;
}

/* 1 when the sample lies in the organ of this face where the step begins. What an organ overlaps itself by is not seen
 * so. */
static int sbi_partner_is_within(sbi_pair_search *search, int other)
{
    int organ = search->contact->pairs.organs[other];
    if (organ == search->contact->pairs.organs[search->face])
        return 1;
    if (organ != search->within_organ)
        search->within = sbi_pairs_is_within(search->contact, organ, search->at, search->contact->x, NULL);
    search->within_organ = organ;
    return search->within;
}

/* 1 when the face may touch another one in this step, or is at least so near that a sample's place tells. */
static int sbi_partner_counts(const sbi_pair_search *search, int other)
{
    return other != search->face && sbi_pairs_may_touch(search->contact, search->face, other) &&
           sbi_pairs_comes(search->contact, search->face, &search->box, other);
}

/* ---- faces near the sample where the step begins ---- */

/* The sample against a face: the point there, and the way from that. */
typedef struct sbi_partner_look {
    sbi_closest closest;
    sb_real height, beside, away; /* m: along the normal (lower than 0: behind), across it, in all */
} sbi_partner_look;

static void sbi_partner_look_at(const sbi_pair_search *search, int other, sbi_partner_look *look)
{
    const sbi_contact_faces *faces = search->contact->faces;
    sb_vec3 x[SB_MAX_FACE_NODES], way, n = sbi_pairs_face_normal(search->contact, other);
    sbi_partner_gather(search->contact, other, x);
    sbi_closest_on_face(&faces->kinds[faces->sizes[other]], x, search->at, &look->closest);
    way = sb_v3_sub(search->at, look->closest.point);
    look->height = sb_v3_dot(n, way);
    look->away = sb_v3_norm(way);
    look->beside = sb_v3_norm(sbi_contact_tangential(way, n));
}

/* 1 when an overlap this deep is one with this face, and not with what is nearer around the sample. */
static int sbi_partner_is_behind_this(sbi_pair_search *search, int other, sb_real depth)
{
    return sbi_partner_is_within(search, other) &&
           sbi_pairs_is_inside(search->contact, search->face, other, search->at, SBI_PARTNER_SIDE * depth,
                               search->contact->x, NULL);
}

/* The face's point may be the nearest of all, too. */
static void sbi_partner_try_nearest(sbi_pair_search *search, int other, sbi_partner_look *look)
{
    sbi_partner_look_at(search, other, look);
    if (search->nearest < 0 || look->away < search->nearest_away) {
        search->nearest = other;
        search->nearest_away = look->away;
        search->nearest_height = look->height;
    }
}

static void sbi_partner_try_near(sbi_pair_search *search, int other, sb_real highest)
{
    sb_contact *contact = search->contact;
    sb_real length = contact->faces->lengths[other], lean;
    sbi_partner_look look;
    int deep;
    sbi_partner_try_nearest(search, other, &look);
    deep = -look.height > SBI_PAIR_DEEP * length;
    lean = look.height > 0 ? SBI_PAIR_LEAN : SBI_PAIR_LEAN_INSIDE;
    if ((!deep && !sbi_pairs_face(contact, search->face, other)) || look.height > highest ||
        -look.height > sbi_pairs_deepest(contact, other) ||
        look.beside > lean * sb_abs(look.height) + SBI_PAIR_BESIDE * length ||
        (search->best >= 0 && !(look.away < search->measure)) ||
        (deep && !sbi_partner_is_behind_this(search, other, -look.height)))
        return;
    search->best = other;
    search->measure = look.away;
    search->closest = look.closest;
}

/* 1 when a face is no nearer than what holds the sample. */
static int sbi_partner_is_no_nearer(const sbi_pair_search *search, const sbi_pair_ball *ball, const sbi_pair_pick *pick)
{
    const sb_real off = sb_max((sb_real)0, sb_abs(pick->height) - ball->plate.bulge);
    const sb_real most = search->measure + SBI_PAIR_BESIDE * search->contact->faces->lengths[ball->face];
    sb_real reach = most * most - off * off;
    if (reach < 0)
        return 1;
    reach = ball->plate.radius + sb_sqrt(reach);
    return pick->beside > reach * reach;
}

/* 1 when a face's own rule may hold the sample: by how high that is above the plane and how far beside the face. No
 * branches: which of a list may is as good as chance. */
SB_INLINE int sbi_partner_may_hold(const sbi_pair_ball *ball, const sbi_pair_pick *pick)
{
    const sb_real height = pick->height, bulge = ball->plate.bulge;
    const sb_real lean = height + bulge > 0 ? SBI_PAIR_LEAN : SBI_PAIR_LEAN_INSIDE;
    const sb_real reach = ball->plate.radius + ball->rounded + lean * (sb_abs(height) + bulge);
    const sb_real ball_reach = ball->plate.radius + ball->most;
    return (pick->square <= ball_reach * ball_reach) & (pick->beside <= reach * reach) &
           (height - bulge <= ball->highest + ball->rounded) & (-height - bulge <= ball->deepest + ball->rounded);
}

/* Those that may hold the sample, in pairs->picks; returns how many. */
static int sbi_partner_pick_holders(const sbi_pair_search *search)
{
    sbi_pairs *pairs = &search->contact->pairs;
    const int *list = pairs->lists[SBI_PAIR_HOLDERS];
    int picked = 0;
    for (int i = 0; i < pairs->list_counts[SBI_PAIR_HOLDERS]; i++) {
        const sbi_pair_ball *ball = pairs->balls + list[i];
        const sbi_pair_pick pick = sbi_partner_pick(ball, list[i], search->at);
        pairs->picks[picked] = pick;
        picked += sbi_partner_may_hold(ball, &pick);
    }
    return picked;
}

/* 1 when one that may hold the sample does so no better than what already does. */
static int sbi_partner_is_useless(const sbi_pair_search *search, const sbi_pair_ball *ball, const sbi_pair_pick *pick)
{
    return search->best >= 0 && (sbi_partner_is_out_of(ball, pick, sb_min(ball->most, search->measure)) ||
                                 sbi_partner_is_no_nearer(search, ball, pick));
}

/* Tries what the sample before this one was nearest to. */
static void sbi_partner_try_first(sbi_pair_search *search, int first)
{
    const sb_real highest = sbi_pairs_highest(search->contact, search->face, first);
    const sbi_pair_ball ball = sbi_partner_make_ball(search, first, highest);
    const sbi_pair_pick pick = sbi_partner_pick(&ball, 0, search->at);
    if (sbi_partner_may_hold(&ball, &pick))
        sbi_partner_try_near(search, first, highest);
}

/* Tries those that may hold the sample; one first. */
static void sbi_partner_try_holders(sbi_pair_search *search, int first)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    const int picked = sbi_partner_pick_holders(search);
    search->best = search->nearest = -1;
    if (first >= 0)
        sbi_partner_try_first(search, first);
    for (int i = 0; i < picked; i++) {
        const sbi_pair_ball *ball = pairs->balls + pairs->picks[i].number;
        if (ball->face != first && !sbi_partner_is_useless(search, ball, pairs->picks + i))
            sbi_partner_try_near(search, ball->face, ball->highest);
    }
}

/* ---- a sample behind faces none of which holds it ---- */

/* The nearest face is no farther than this (m): as far as one is known to be that counts. */
static sb_real sbi_partner_nearest_at_most(const sbi_pair_search *search, int first)
{
    const sb_contact *contact = search->contact;
    const sbi_pairs *pairs = &contact->pairs;
    if (search->nearest >= 0)
        return search->nearest_away;
    if (first < 0 || sbi_partner_is_far(search, first, sbi_partner_farthest(contact, first)))
        return SB_REAL_MAX;
    return sb_v3_norm(sb_v3_sub(search->at, pairs->plates[first].middle)) +
           (pairs->plates[first].bulge > 0 ? pairs->plates[first].radius : 0);
}

/* 1 when a sample may lie straight behind a face, no farther than that, as far as its plane tells. */
SB_INLINE int sbi_partner_may_lie_behind(const sbi_pair_ball *ball, const sbi_pair_pick *pick, sb_real most)
{
    const sb_real height = pick->height, bulge = ball->plate.bulge;
    const sb_real reach = ball->plate.radius + SBI_PAIR_SLANTED * (bulge - height) + ball->rounded;
    const sb_real ball_reach = ball->plate.radius + sb_min(most, ball->most);
    return (pick->square <= ball_reach * ball_reach) & (height < bulge) & (-height - bulge <= most + ball->rounded) &
           (pick->beside <= reach * reach);
}

/* The same by the nearest point of the face. */
static int sbi_partner_may_be_behind(const sbi_pair_search *search, const sbi_pair_ball *ball, sb_real most)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    sbi_partner_look look;
    if (pairs->organs[ball->face] == pairs->organs[search->face])
        return 0;
    sbi_partner_look_at(search, ball->face, &look);
    return look.away < most + ball->rounded && SBI_PAIR_TURNED * look.away < ball->rounded - look.height;
}

/* 1 when it may lie straight behind some face, no farther than the nearest is: that of all is to be found. */
static int sbi_partner_is_behind_any(const sbi_pair_search *search, int first)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    const int *list = pairs->lists[SBI_PAIR_BACKS];
    sb_real most = sbi_partner_nearest_at_most(search, first);
    for (int i = 0; i < pairs->list_counts[SBI_PAIR_BACKS]; i++) {
        const sbi_pair_ball *ball = pairs->balls + list[i];
        const sbi_pair_pick pick = sbi_partner_pick(ball, list[i], search->at);
        if (sbi_partner_may_lie_behind(ball, &pick, most) && sbi_partner_may_be_behind(search, ball, most))
            return 1;
    }
    return 0;
}

/* The nearest of all that the face may come near, whether or not its own rule can hold the sample. */
static void sbi_partner_find_nearest(sbi_pair_search *search)
{
    const sb_contact *contact = search->contact;
    for (int i = 0; i < search->coming_count; i++) {
        const int other = search->coming[i];
        sbi_partner_look look;
        if ((search->nearest < 0 || !sbi_partner_is_far(search, other, search->nearest_away)) &&
            !sbi_partner_is_far(search, other, sbi_partner_farthest(contact, other)) &&
            sbi_partner_counts(search, other))
            sbi_partner_try_nearest(search, other, &look);
    }
}

/* 1 when the nearest face of another organ is behind the sample; else that is beside it. */
static int sbi_partner_is_behind(const sbi_pair_search *search)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    return search->nearest >= 0 && pairs->organs[search->nearest] != pairs->organs[search->face] &&
           search->nearest_height < -SBI_PAIR_TURNED * search->nearest_away;
}

/* Such a sample may lie in a fold of the other organ, nearest to an edge or a corner there, or to a face that does not
 * look at it: the nearest of all faces decides. */
static void sbi_partner_try_around(sbi_pair_search *search)
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
            if (pairs->organs[other] != organ || sbi_partner_is_far(search, other, most) ||
                !sbi_pairs_are_apart(contact, search->face, other))
                continue;
            sbi_partner_gather(contact, other, x);
            sbi_closest_on_face(&faces->kinds[faces->sizes[other]], x, at, &closest);
            away = sb_v3_norm(sb_v3_sub(at, closest.point));
            if (pass == 0 && away < least)
                least = away, best = other, search->closest = closest;
            if (pass == 1 && away <= least * (1 + SBI_PAIR_BESIDE)) /* those of its edge or corner */
                sum = sb_v3_add(sum, sbi_pairs_face_normal(contact, other));
        }
    if (best < 0 ||
        !(sb_v3_dot(sum, sb_v3_sub(at, search->closest.point)) < -SBI_PAIR_TURNED * sb_v3_norm(sum) * least) ||
        !(sb_v3_dot(sum, own) < SBI_PAIR_TURNED * sb_v3_norm(sum)) || least > sbi_pairs_deepest(contact, best) ||
        !sbi_partner_is_within(search, best))
        return;
    search->best = best;
}

/* ---- a face that the sample will come to on its way ---- */

/* 1 when a face may be on the sample's way, which is that long (m). */
SB_INLINE int sbi_partner_may_come(const sbi_pair_ball *ball, const sbi_pair_pick *pick, sb_real way)
{
    const sb_real most = SBI_PARTNER_LOOSE * (way + ball->goes), reach = ball->plate.radius + most;
    return (pick->square <= reach * reach) & (pick->height - ball->plate.bulge <= most + ball->rounded);
}

static void sbi_partner_try_way(sbi_pair_search *search, int other)
{
    const sb_contact *contact = search->contact;
    const sbi_contact_kind *kind = &contact->faces->kinds[contact->faces->sizes[other]];
    const int *nodes = sbi_contact_face_nodes(contact->faces, other);
    const sb_vec3 against = sb_v3_sub(search->way, contact->pairs.ways[other]);
    sb_vec3 x[SB_MAX_FACE_NODES], v[SB_MAX_FACE_NODES];
    const sb_real most = sb_v3_norm(against) + contact->pairs.spreads[other];
    if (sbi_pairs_is_above(contact, other, search->at, most) || sbi_partner_is_far(search, other, most))
        return;
    sbi_partner_gather(contact, other, x);
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
        if (share < 0)
            continue;
        search->best = other;
        search->measure = share;
        for (int a = 0; a < kind->nodes; a++)
            v[a] = sb_v3_madd(x[a], share, v[a]);
        sbi_closest_on_face(kind, v, sb_v3_madd(search->at, share, search->way), &search->closest);
        return;
    }
}

/* The first that it comes to. */
static void sbi_partner_try_ways(sbi_pair_search *search)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    const int *list = pairs->lists[SBI_PAIR_COMERS];
    const sb_real way = sb_v3_norm(search->way);
    for (int i = 0; search->best < 0 && i < pairs->list_counts[SBI_PAIR_COMERS]; i++) {
        const sbi_pair_ball *ball = pairs->balls + list[i];
        const sbi_pair_pick pick = sbi_partner_pick(ball, list[i], search->at);
        if (sbi_partner_may_come(ball, &pick, way))
            sbi_partner_try_way(search, ball->face);
    }
}

/* ---- a face and its samples ---- */

/* A face that may come near, in the lists in which samples look for it. */
static void sbi_partner_list_face(sbi_pair_search *search, int other, int lists, sb_real highest)
{
    sbi_pairs *pairs = &search->contact->pairs;
    pairs->balls[search->listed] = sbi_partner_make_ball(search, other, highest);
    for (int list = 0; list < SBI_PAIR_LISTS; list++) { /* no branches */
        pairs->lists[list][pairs->list_counts[list]] = search->listed;
        pairs->list_counts[list] += lists >> list & 1;
    }
    search->listed++;
}

SBI_API void sbi_pairs_begin_search(sb_contact *contact, const sbi_touch_step *step, int face, sbi_pair_search *search)
{
    int relating;
    memset(search, 0, sizeof *search);
    search->contact = contact;
    search->step = step;
    search->face = face;
    search->first = -1;
    search->box = sbi_pairs_way_box(contact, face);
    search->coming_count = sbi_pairs_find_coming(contact, face, &search->coming);
    memset(contact->pairs.list_counts, 0, sizeof contact->pairs.list_counts);
    relating = sbi_pairs_find_relating(contact, face, search->coming, search->coming_count);
    for (int i = 0; i < relating; i++) {
        const int other = contact->pairs.relating[i];
        sb_real highest = 0;
        int lists = sbi_pairs_relate(contact, face, other, &highest);
        if (lists && sbi_partner_counts(search, other))
            sbi_partner_list_face(search, other, lists, highest);
    }
    search->slips = search->listed > 0 && sbi_pairs_is_inside_out(contact, face);
}

SBI_API void sbi_pairs_find_partner(sbi_pair_search *search, sb_vec3 at, sb_vec3 way)
{
    const int first = search->first;
    search->at = at;
    search->way = way;
    search->within_organ = -1;
    sbi_partner_try_holders(search, first);
    if (search->best < 0 && sbi_partner_is_behind_any(search, first)) {
        sbi_partner_find_nearest(search);
        if (sbi_partner_is_behind(search))
            sbi_partner_try_around(search);
    }
    if (search->nearest >= 0)
        search->first = search->best >= 0 ? search->best : search->nearest;
    if (search->best < 0)
        sbi_partner_try_ways(search);
}
