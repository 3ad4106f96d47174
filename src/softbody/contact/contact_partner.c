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

/* What the sample is to faces side by side. */
static void sbi_partner_measure(const sbi_pair_balls *SB_RESTRICT balls, sb_vec3 at, sbi_pair_picks *SB_RESTRICT picks)
{
    SBI_PAIR_EACH_SIDE(l)
    {
        const sb_real x = at.x - balls->middle[0][l], y = at.y - balls->middle[1][l], z = at.z - balls->middle[2][l];
        const sb_real height = balls->normal[0][l] * x + balls->normal[1][l] * y + balls->normal[2][l] * z;
        const sb_real square = x * x + y * y + z * z;
        picks->height[l] = height;
        picks->square[l] = square;
        picks->beside[l] = square - height * height;
    }
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

static void sbi_partner_clear_balls(sbi_pair_balls *balls)
{
    memset(balls, 0, sizeof *balls);
    for (int list = 0; list < SBI_PAIR_LISTS; list++)
        for (int l = 0; l < SBI_PAIR_SIDE; l++)
            balls->out_of[list][l] = 1;
}

/* Puts a face in its place among those side by side. */
static void sbi_partner_put_ball(const sbi_pair_search *search, const sbi_pair_related *related, sbi_pair_balls *balls,
                                 int l)
{
    const sb_contact *contact = search->contact;
    const sbi_pairs *pairs = &contact->pairs;
    const int other = related->other;
    const sbi_pair_plate *plate = pairs->plates + other;
    balls->middle[0][l] = plate->middle.x, balls->middle[1][l] = plate->middle.y, balls->middle[2][l] = plate->middle.z;
    balls->normal[0][l] = plate->normal.x, balls->normal[1][l] = plate->normal.y, balls->normal[2][l] = plate->normal.z;
    balls->radius[l] = plate->radius;
    balls->bulge[l] = plate->bulge;
    balls->most[l] = sbi_partner_farthest(contact, other);
    balls->highest[l] = related->highest;
    balls->deepest[l] = sbi_pairs_deepest(contact, other);
    balls->goes[l] = sb_v3_norm(pairs->ways[other]) + pairs->spreads[other];
    balls->rounded[l] = sbi_partner_rounded(search, other);
    balls->face[l] = other;
    for (int list = 0; list < SBI_PAIR_LISTS; list++)
        balls->out_of[list][l] = (sb_real)(~related->lists >> list & 1);
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
static int sbi_partner_is_no_nearer(const sbi_pair_search *search, const sbi_pair_balls *balls,
                                    const sbi_pair_picks *picks, int l)
{
    const sb_real off = sb_max((sb_real)0, sb_abs(picks->height[l]) - balls->bulge[l]);
    const sb_real most = search->measure + SBI_PAIR_BESIDE * search->contact->faces->lengths[balls->face[l]];
    sb_real reach = most * most - off * off;
    if (reach < 0)
        return 1;
    reach = balls->radius[l] + sb_sqrt(reach);
    return picks->beside[l] > reach * reach;
}

/* Which faces' own rules may hold the sample: by how high that is above the plane and how far beside the face. */
static void sbi_partner_ask_holders(const sbi_pair_balls *SB_RESTRICT balls, sbi_pair_picks *SB_RESTRICT picks)
{
    SBI_PAIR_EACH_SIDE(l)
    {
        const sb_real height = picks->height[l], bulge = balls->bulge[l], rounded = balls->rounded[l];
        const sb_real lean = height + bulge > 0 ? SBI_PAIR_LEAN : SBI_PAIR_LEAN_INSIDE;
        const sb_real reach = balls->radius[l] + rounded + lean * (sb_abs(height) + bulge);
        const sb_real ball_reach = balls->radius[l] + balls->most[l];
        const sb_real far = sb_max(picks->square[l] - ball_reach * ball_reach, picks->beside[l] - reach * reach);
        const sb_real high = height - bulge - (balls->highest[l] + rounded);
        const sb_real deep = -height - bulge - (balls->deepest[l] + rounded);
        picks->off[l] = sb_max(sb_max(far, balls->out_of[SBI_PAIR_HOLDERS][l]), sb_max(high, deep));
    }
}

/* 1 when one that may hold the sample does so no better than what already does. */
static int sbi_partner_is_useless(const sbi_pair_search *search, const sbi_pair_balls *balls,
                                  const sbi_pair_picks *picks, int l)
{
    const sb_real reach = balls->radius[l] + sb_min(balls->most[l], search->measure);
    return search->best >= 0 && (picks->square[l] > reach * reach || sbi_partner_is_no_nearer(search, balls, picks, l));
}

/* One that is in no list, as if it were in that of holders. */
static void sbi_partner_try_unlisted(sbi_pair_search *search, int other)
{
    sbi_pair_related related;
    sbi_pair_balls balls;
    sbi_pair_picks picks;
    sbi_partner_clear_balls(&balls);
    related.other = other;
    related.lists = 1 << SBI_PAIR_HOLDERS;
    related.highest = sbi_pairs_highest(search->contact, search->face, other);
    sbi_partner_put_ball(search, &related, &balls, 0);
    sbi_partner_measure(&balls, search->at, &picks);
    sbi_partner_ask_holders(&balls, &picks);
    if (!(picks.off[0] > 0))
        sbi_partner_try_near(search, other, related.highest);
}

/* Tries what the sample before this one was nearest to. */
static void sbi_partner_try_first(sbi_pair_search *search)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    const int side = search->first_place / SBI_PAIR_SIDE, l = search->first_place % SBI_PAIR_SIDE;
    if (search->first_place < 0)
        sbi_partner_try_unlisted(search, search->first);
    else if (!(pairs->picks[side].off[l] > 0))
        sbi_partner_try_near(search, search->first, pairs->balls[side].highest[l]);
}

/* The next sample begins with a face. */
static void sbi_partner_begin_with(sbi_pair_search *search, int face)
{
    const sbi_pair_balls *balls = search->contact->pairs.balls;
    int place = 0;
    if (face == search->first)
        return;
    while (place < search->listed && balls[place / SBI_PAIR_SIDE].face[place % SBI_PAIR_SIDE] != face)
        place++;
    search->first = face;
    search->first_place = place < search->listed ? place : -1;
}

/* Tries those that may hold the sample; one first. */
static void sbi_partner_try_holders(sbi_pair_search *search)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    const int sides = sbi_pairs_sides(search->listed);
    for (int side = 0; side < sides; side++) {
        sbi_partner_measure(pairs->balls + side, search->at, pairs->picks + side);
        sbi_partner_ask_holders(pairs->balls + side, pairs->picks + side);
    }
    search->best = search->nearest = -1;
    if (search->first >= 0)
        sbi_partner_try_first(search);
    for (int side = 0; side < sides; side++) {
        const sbi_pair_balls *balls = pairs->balls + side;
        const sbi_pair_picks *picks = pairs->picks + side;
        for (int l = 0; l < SBI_PAIR_SIDE; l++)
            if (!(picks->off[l] > 0) && balls->face[l] != search->first &&
                !sbi_partner_is_useless(search, balls, picks, l))
                sbi_partner_try_near(search, balls->face[l], balls->highest[l]);
    }
}

/* ---- a sample behind faces none of which holds it ---- */

/* The nearest face is no farther than this (m): as far as one is known to be that counts. */
static sb_real sbi_partner_nearest_at_most(const sbi_pair_search *search)
{
    const int first = search->first;
    const sb_contact *contact = search->contact;
    const sbi_pairs *pairs = &contact->pairs;
    if (search->nearest >= 0)
        return search->nearest_away;
    if (first < 0 || sbi_pairs_is_beyond(contact, first, search->at, sbi_partner_farthest(contact, first)))
        return SB_REAL_MAX;
    return sb_v3_norm(sb_v3_sub(search->at, pairs->plates[first].middle)) +
           (pairs->plates[first].bulge > 0 ? pairs->plates[first].radius : 0);
}

/* Which faces the sample may lie straight behind, no farther than `most`, as far as their planes tell. */
static void sbi_partner_ask_backs(const sbi_pair_balls *SB_RESTRICT balls, sb_real most,
                                  sbi_pair_picks *SB_RESTRICT picks)
{
    SBI_PAIR_EACH_SIDE(l)
    {
        const sb_real height = picks->height[l], bulge = balls->bulge[l], rounded = balls->rounded[l];
        const sb_real reach = balls->radius[l] + SBI_PAIR_SLANTED * (bulge - height) + rounded;
        const sb_real ball_reach = balls->radius[l] + sb_min(most, balls->most[l]);
        const sb_real far = sb_max(picks->square[l] - ball_reach * ball_reach, picks->beside[l] - reach * reach);
        const sb_real deep = -height - bulge - (most + rounded);
        const sb_real front = height < bulge ? (sb_real)0 : (sb_real)1;
        picks->off[l] = sb_max(sb_max(far, balls->out_of[SBI_PAIR_BACKS][l]), sb_max(front, deep));
    }
}

/* The same of one by its nearest point. */
static int sbi_partner_may_be_behind(const sbi_pair_search *search, int other, sb_real most, sb_real rounded)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    sbi_partner_look look;
    if (pairs->organs[other] == pairs->organs[search->face])
        return 0;
    sbi_partner_look_at(search, other, &look);
    return look.away < most + rounded && SBI_PAIR_TURNED * look.away < rounded - look.height;
}

/* 1 when it may lie straight behind some face, no farther than the nearest is: that of all is to be found. */
static int sbi_partner_is_behind_any(const sbi_pair_search *search)
{
    const sbi_pairs *pairs = &search->contact->pairs;
    sb_real most = sbi_partner_nearest_at_most(search);
    for (int side = 0; side < sbi_pairs_sides(search->listed); side++) {
        const sbi_pair_balls *balls = pairs->balls + side;
        sbi_pair_picks *picks = pairs->picks + side;
        sbi_partner_ask_backs(balls, most, picks);
        for (int l = 0; l < SBI_PAIR_SIDE; l++)
            if (!(picks->off[l] > 0) && sbi_partner_may_be_behind(search, balls->face[l], most, balls->rounded[l]))
                return 1;
    }
    return 0;
}

/* How far the face is that the sample before this one was nearest to: what is farther is not the nearest. */
static sb_real sbi_partner_first_away(const sbi_pair_search *search)
{
    sbi_partner_look look;
    if (search->first_place < 0 || sbi_pairs_is_beyond(search->contact, search->first, search->at,
                                                       sbi_partner_farthest(search->contact, search->first)))
        return SB_REAL_MAX / 4;
    sbi_partner_look_at(search, search->first, &look);
    return look.away;
}

/* The nearest of all that the face may come near, whether or not its own rule can hold the sample. */
static void sbi_partner_find_nearest(sbi_pair_search *search)
{
    const sb_contact *contact = search->contact;
    sb_real most = search->nearest < 0 ? sbi_partner_first_away(search) : search->nearest_away;
    for (int i = 0; i < search->coming_count; i++) {
        const int other = search->coming[i];
        sbi_partner_look look;
        if (sbi_pairs_is_beyond(contact, other, search->at, sb_min(most, sbi_partner_farthest(contact, other))) ||
            !sbi_partner_counts(search, other))
            continue;
        sbi_partner_try_nearest(search, other, &look);
        most = sb_min(most, search->nearest_away);
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
            if (pairs->organs[other] != organ || sbi_pairs_is_beyond(contact, other, search->at, most) ||
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

/* Which faces may be on the sample's way, which is that long (m). */
static void sbi_partner_ask_comers(const sbi_pair_balls *SB_RESTRICT balls, sb_real way,
                                   sbi_pair_picks *SB_RESTRICT picks)
{
    SBI_PAIR_EACH_SIDE(l)
    {
        const sb_real most = SBI_PARTNER_LOOSE * (way + balls->goes[l]), reach = balls->radius[l] + most;
        const sb_real high = picks->height[l] - balls->bulge[l] - (most + balls->rounded[l]);
        picks->off[l] = sb_max(sb_max(picks->square[l] - reach * reach, balls->out_of[SBI_PAIR_COMERS][l]), high);
    }
}

static void sbi_partner_try_way(sbi_pair_search *search, int other)
{
    const sb_contact *contact = search->contact;
    const sbi_contact_kind *kind = &contact->faces->kinds[contact->faces->sizes[other]];
    const int *nodes = sbi_contact_face_nodes(contact->faces, other);
    const sb_vec3 against = sb_v3_sub(search->way, contact->pairs.ways[other]);
    sb_vec3 x[SB_MAX_FACE_NODES], v[SB_MAX_FACE_NODES];
    const sb_real most = sb_v3_norm(against) + contact->pairs.spreads[other];
    if (sbi_pairs_is_above(contact, other, search->at, most) || sbi_pairs_is_beyond(contact, other, search->at, most))
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
    const sb_real way = sb_v3_norm(search->way);
    for (int side = 0; search->best < 0 && side < sbi_pairs_sides(search->listed); side++) {
        const sbi_pair_balls *balls = pairs->balls + side;
        sbi_pair_picks *picks = pairs->picks + side;
        sbi_partner_ask_comers(balls, way, picks);
        for (int l = 0; search->best < 0 && l < SBI_PAIR_SIDE; l++)
            if (!(picks->off[l] > 0))
                sbi_partner_try_way(search, balls->face[l]);
    }
}

/* ---- a face and its samples ---- */

/* A face that may come near, among those that samples look at. */
static void sbi_partner_list_face(sbi_pair_search *search, const sbi_pair_related *related)
{
    const int place = search->listed++, l = place % SBI_PAIR_SIDE;
    sbi_pair_balls *balls = search->contact->pairs.balls + place / SBI_PAIR_SIDE;
    if (l == 0)
        sbi_partner_clear_balls(balls);
    sbi_partner_put_ball(search, related, balls, l);
}

SBI_API void sbi_pairs_begin_search(sb_contact *contact, const sbi_touch_step *step, int face, sbi_pair_search *search)
{
    int count;
    memset(search, 0, sizeof *search);
    search->contact = contact;
    search->step = step;
    search->face = face;
    search->first = search->first_place = -1;
    search->box = sbi_pairs_way_box(contact, face);
    search->coming_count = sbi_pairs_find_coming(contact, face, &search->coming);
    count = sbi_pairs_find_related(contact, face, &search->box, search->coming, search->coming_count);
    for (int i = 0; i < count; i++) {
        const int other = contact->pairs.related[i].other;
        if (other != face && sbi_pairs_may_touch(contact, face, other))
            sbi_partner_list_face(search, contact->pairs.related + i);
    }
    search->slips = search->listed > 0 && sbi_pairs_is_inside_out(contact, face);
}

SBI_API void sbi_pairs_find_partner(sbi_pair_search *search, sb_vec3 at, sb_vec3 way)
{
    search->at = at;
    search->way = way;
    search->within_organ = -1;
    sbi_partner_try_holders(search);
    if (search->best < 0 && sbi_partner_is_behind_any(search)) {
        sbi_partner_find_nearest(search);
        if (sbi_partner_is_behind(search))
            sbi_partner_try_around(search);
    }
    if (search->nearest >= 0)
        sbi_partner_begin_with(search, search->best >= 0 ? search->best : search->nearest);
    if (search->best < 0)
        sbi_partner_try_ways(search);
}
