/* contact_pairs: organs in touch within a step: samples and what they are paired with, forces, blocks, what couples. */
#include "contact_pairs.h"

#include <math.h>
#include <string.h>

#include "../body/body_private.h"
#include "contact_private.h"

enum { SBI_PAIR_CHUNK = 64, SBI_PAIR_THINNEST = 5, SBI_PAIR_MOST_PARTS = 1024 };

/* Of the body's own stiffness at the surface, for the two sides' harmonic mean. */
#define SBI_PAIR_STIFFNESS ((sb_real)3)
/* More than what rounding makes of a way. */
#define SBI_PAIR_ROUNDED ((sb_real)1.001)
/* Of what is safe: a step at whose end samples would be deeper than this, if nothing held them, is divided at once. */
#define SBI_PAIR_COASTS ((sb_real)2)

/* ---- pairing ---- */

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
    s->friction = search->slips || sbi_pairs_is_inside_out(contact, search->best) ? 0 : pairs->friction;
    sbi_pair_turn_out(s, contact->faces->lengths[search->best]);
    sbi_pair_foresee(search, s);
    pairs->sample_count++;
    return 1;
}

/* Triangles of a skin for each of those that have samples: there may be too many for one each. */
static int sbi_pair_stride(const sb_contact *contact, int thin) { return contact->skin.source ? 1 << thin : 1; }

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
    if (face % sbi_pair_stride(contact, thin) != 0)
        return 1;
    if (pairs->patch_count == pairs->patch_room)
        return 0;
    memset(patch, 0, sizeof *patch);
    patch->first = pairs->sample_count;
    sbi_pairs_begin_search(contact, step, face, &search);
    for (int i = 0; search.listed > 0 && i < rule->count; i++) {
        const sb_real *weights = rule->weights + (size_t)i * (size_t)count;
        sbi_pairs_find_partner(&search, sbi_contact_mean(weights, nodes, count, contact->x),
                               sb_v3_scale(step->dt, sbi_contact_mean(weights, nodes, count, step->velocity)));
        if (search.best >= 0 && !sbi_pair_add_sample(&search, i, weights))
            return 0;
    }
    patch->count = pairs->sample_count - patch->first;
    if (patch->count == 0) {
        if (thin == 0)
            sbi_pairs_let_be(contact, face);
        return 1;
    }
    patch->face = face;
    patch->parts = parts;
    for (int a = 0; a < count; a++)
        patch->nodes[a] = sbi_contact_place_node(contact, nodes[a]);
    for (int i = patch->first; i < pairs->sample_count; i++) {
        sbi_pair_sample *s = pairs->samples + i;
        sb_real area = sbi_contact_sample_area(faces, contact->body, face, parts, s->sample);
        s->area = (sb_real)sbi_pair_stride(contact, thin) * area / 2;
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

/* Takes back nodes from `count` on, of a skin those of the body from `listed` on. */
static void sbi_pair_return_nodes(sb_contact *contact, int count, int listed)
{
    sbi_contact_skin *skin = &contact->skin;
    while (contact->node_count > count)
        contact->node_place[contact->nodes[--contact->node_count]] = -1;
    while (skin->list_count > listed)
        skin->place[skin->list[--skin->list_count]] = -1;
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
    int nodes = contact->node_count, listed = contact->skin.list_count;
    contact->touch.links = 0;
    pairs->link_count = pairs->saved_count = 0;
    pairs->zones_made = SBI_ZONES_NONE;
    if (!pairs->kinds)
        return SB_OK;
    pairs->reach = sb_max(pairs->longest, pairs->distance);
    sbi_pairs_look(contact, contact->x);
    sbi_pairs_follow(contact, step->velocity, step->dt);
    sbi_pairs_renew_near(contact, step);
    sbi_pairs_box_near(contact);
    for (int thin = 0;; thin++) {
        int face = sbi_pairs_next_near(contact, 0);
        sbi_pairs_forget(contact);
        sbi_pair_return_nodes(contact, nodes, listed);
        while (face >= 0 &&
               ((thin == 0 && sbi_pairs_is_still(contact, face)) || sbi_pair_add_patch(contact, step, face, thin)))
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
    sb_real farthest; /* m: the most that a node goes */
} sbi_pair_work;

/* How far nodes go at most. */
static sb_real sbi_pair_measure_way(const sb_contact *contact, const sb_vec3 *du)
{
    sb_real square = 0;
    for (int i = 0; i < contact->node_count; i++)
        square = sb_max(square, sb_v3_dot(du[i], du[i]));
    return sb_sqrt(square);
}

/* 1 when a sample stays too far from its partner for any pressure, wherever in reach both go. Friction of a bound that
 * is still to be renewed does not end with the pressure. */
static int sbi_pair_stays_off(const sbi_pair_work *work, const sbi_pair_sample *s)
{
    const sbi_contact_faces *faces = work->contact->faces;
    const sbi_contact_kind *one = &faces->kinds[faces->sizes[s->face]], *two = &faces->kinds[faces->sizes[s->other]];
    sb_real way = (one->rules[one->most].spread + two->rules[two->most].spread) * work->farthest;
    sb_real gap = sb_v3_dot(s->normal, s->start) - work->contact->pairs.distance - SBI_PAIR_ROUNDED * way;
    return gap > 0 && s->k * gap > s->memory && (work->renew || !(s->bound > 0));
}

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
        s->bound = s->friction * sb_max((sb_real)0, s->memory - s->k * (s->gap - s->left));
    s->answer = sbi_contact_law(s->k, s->gap - s->left, s->memory, s->normal, motion, s->remembered, s->bound);
}

static void sbi_pair_evaluate_chunk(void *user, int chunk)
{
    const sbi_pair_work *work = (const sbi_pair_work *)user;
    sbi_pairs *pairs = &work->contact->pairs;
    int last = sbi_min_int((chunk + 1) * SBI_PAIR_CHUNK, pairs->sample_count);
    for (int i = chunk * SBI_PAIR_CHUNK; i < last; i++) {
        sbi_pair_sample *s = pairs->samples + i;
        if (!sbi_pair_stays_off(work, s)) {
            sbi_pair_evaluate_sample(work, s);
            continue;
        }
        memset(&s->answer, 0, sizeof s->answer);
        s->bound = 0;
    }
}

SB_INLINE sb_vec3 sbi_pair_force(const sbi_pair_sample *s)
{
    return sb_v3_scale(s->area, sb_v3_madd(s->answer.traction, s->answer.pressure, s->normal));
}

SBI_FORCE_INLINE void sbi_pair_add_of(const sb_real *weights, const int *places, int count, sb_real sign, sb_vec3 f,
                                      sb_vec3 *out)
{
    for (int a = 0; a < count; a++)
        out[places[a]] = sb_v3_madd(out[places[a]], sign * weights[a], f);
}

/* out, by place, += sign f with weights of a face's nodes; of triangles without a loop. */
SBI_FORCE_INLINE void sbi_pair_add(const sb_real *weights, const int *places, int count, sb_real sign, sb_vec3 f,
                                   sb_vec3 *out)
{
    if (count == 3)
        sbi_pair_add_of(weights, places, 3, sign, f, out);
    else
        sbi_pair_add_of(weights, places, count, sign, f, out);
}

/* Adds f to one side's nodes and takes it from the other's. */
SB_INLINE void sbi_pair_scatter(const sb_contact *contact, const sbi_pair_sample *s, sb_vec3 f, sb_vec3 *out)
{
    const unsigned char *sizes = contact->faces->sizes;
    sbi_pair_add(s->weights, contact->pairs.patches[s->patch].nodes, sizes[s->face], 1, f, out);
    sbi_pair_add(s->shares, s->other_nodes, sizes[s->other], -1, f, out);
}

SBI_API void sbi_pairs_evaluate(sb_contact *contact, const sb_vec3 *du, int renew)
{
    sbi_pairs *pairs = &contact->pairs;
    int chunks = pairs->sample_count / SBI_PAIR_CHUNK + (pairs->sample_count % SBI_PAIR_CHUNK != 0);
    sbi_pair_work work;
    work.contact = contact;
    work.du = du;
    work.renew = renew;
    work.farthest = sbi_pair_measure_way(contact, du);
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

SB_INLINE sb_vec3 sbi_pair_times(const sbi_pair_link *link, sb_vec3 v)
{
    sb_vec3 out = sb_v3_scale(link->tangent, v);
    out = sb_v3_madd(out, (link->normal - link->tangent) * sb_v3_dot(link->n, v), link->n);
    return sb_v3_madd(out, -link->tangent * sb_v3_dot(link->d, v), link->d);
}

SB_INLINE sbi_pair_link sbi_pair_make_link(const sbi_pairs *pairs, int sample)
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

/* A face's nodes by places. */
typedef struct sbi_pair_places {
    const sb_contact *contact;
    const unsigned char *masked; /* NULL: no axes are */
    const int *places;
    const sb_real *weights;
} sbi_pair_places;

SBI_FORCE_INLINE sb_vec3 sbi_pair_add_mean_of(const sbi_pair_places *face, int count, sb_real sign, const sb_vec3 *x,
                                              sb_vec3 sum)
{
    for (int a = 0; a < count; a++) {
        const int place = face->places[a];
        const unsigned axes = face->masked ? face->masked[face->contact->nodes[place]] : 0u;
        sum = sb_v3_madd(sum, sign * face->weights[a], axes ? sbi_contact_unmasked(axes, x[place]) : x[place]);
    }
    return sum;
}

/* sum + sign times the mean of x, by places, without masked axes; of triangles without a loop. */
SBI_FORCE_INLINE sb_vec3 sbi_pair_add_mean(const sbi_pair_places *face, int count, sb_real sign, const sb_vec3 *x,
                                           sb_vec3 sum)
{
    return count == 3 ? sbi_pair_add_mean_of(face, 3, sign, x, sum) : sbi_pair_add_mean_of(face, count, sign, x, sum);
}

SBI_API void sbi_pairs_multiply(const sb_contact *contact, const unsigned char *masked, const sb_vec3 *x, sb_vec3 *out)
{
    const sbi_pairs *pairs = &contact->pairs;
    const unsigned char *sizes = contact->faces->sizes;
    for (int i = 0; i < pairs->active_count; i++) {
        const sbi_pair_sample *s = pairs->samples + pairs->active[i];
        const sbi_pair_link link = sbi_pair_make_link(pairs, pairs->active[i]);
        const sbi_pair_places one = {contact, masked, pairs->patches[s->patch].nodes, s->weights};
        const sbi_pair_places two = {contact, masked, s->other_nodes, s->shares};
        sb_vec3 way = {0, 0, 0};
        way = sbi_pair_add_mean(&one, sizes[s->face], 1, x, way);
        way = sbi_pair_add_mean(&two, sizes[s->other], -1, x, way);
        sbi_pair_scatter(contact, s, sbi_pair_times(&link, way), out);
    }
}

/* A face's blocks of nodes a <= b += K of a sample with these weights of its nodes. */
static void sbi_pair_sum_blocks(sb_contact *contact, int face, const sb_real *SB_RESTRICT weights,
                                const sb_real *SB_RESTRICT k)
{
    size_t square = (size_t)contact->faces->width * (size_t)contact->faces->width;
    int slot = contact->pairs.slot_of[face], count = contact->faces->sizes[face];
    sb_real(*SB_RESTRICT blocks)[9] = contact->pairs.blocks + (size_t)slot * square;
    if (!contact->pairs.slot_used[slot])
        memset(blocks, 0, square * sizeof *blocks);
    contact->pairs.slot_used[slot] = 1;
    for (int a = 0; a < count; a++)
        for (int b = a; b < count; b++) {
            const sb_real share = weights[a] * weights[b];
            for (int c = 0; c < 9; c++)
                blocks[a * count + b][c] += share * k[c];
        }
}

/* Those of nodes a > b are the same as of b and a. */
static void sbi_pair_mirror_blocks(sb_contact *contact, int slot)
{
    size_t square = (size_t)contact->faces->width * (size_t)contact->faces->width;
    int count = contact->faces->sizes[contact->pairs.slots[slot]];
    sb_real(*blocks)[9] = contact->pairs.blocks + (size_t)slot * square;
    for (int a = 0; a < count; a++)
        for (int b = 0; b < a; b++)
            memcpy(blocks[a * count + b], blocks[b * count + a], sizeof *blocks);
}

static void sbi_pair_make_blocks(sb_contact *contact)
{
    sbi_pairs *pairs = &contact->pairs;
    memset(pairs->slot_used, 0, (size_t)pairs->slot_count);
    for (int i = 0; i < pairs->active_count; i++) {
        const sbi_pair_sample *s = pairs->samples + pairs->active[i];
        sb_real k[9];
        sbi_contact_stiffness(&s->answer, s->normal, s->area, k);
        sbi_pair_sum_blocks(contact, pairs->patches[s->patch].face, s->weights, k);
        sbi_pair_sum_blocks(contact, s->other, s->shares, k);
    }
    for (int slot = 0; slot < pairs->slot_count; slot++)
        if (pairs->slot_used[slot])
            sbi_pair_mirror_blocks(contact, slot);
}

static void sbi_pair_add_slot(sb_contact *contact, int slot, const unsigned char *masked, sb_matrix *matrix)
{
    sbi_pairs *pairs = &contact->pairs;
    size_t width = (size_t)contact->faces->width;
    int face = pairs->slots[slot], count = contact->faces->sizes[face];
    const int *nodes = sbi_contact_face_nodes(contact->faces, face), *places;
    const sb_real(*blocks)[9] = (const sb_real(*)[9])(pairs->blocks + (size_t)slot * width * width);
    if (contact->skin.source) {
        sbi_contact_skin_add_face(contact, masked, matrix, face, blocks);
        return;
    }
    places = sbi_contact_face_blocks(contact->faces, contact->body, face);
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
        if (pairs->slot_used[slot])
            sbi_pair_add_slot(contact, slot, masked, matrix);
    for (int i = 0; i < pairs->active_count; i++)
        pairs->links[pairs->link_count++] = sbi_pair_make_link(pairs, pairs->active[i]);
    pairs->link_node_count = contact->node_count;
    memcpy(pairs->link_nodes, contact->nodes, (size_t)contact->node_count * sizeof(int));
}

SBI_API void sbi_pairs_restore_blocks(sb_contact *contact, sb_matrix *matrix)
{
    sbi_pairs *pairs = &contact->pairs;
    while (pairs->saved_count > 0) { /* backwards, since faces share blocks */
        const sbi_contact_saved *saved = pairs->saved + --pairs->saved_count;
        memcpy(matrix->blocks[saved->block], saved->values, sizeof saved->values);
    }
}

/* ---- products with links: between points of a skin, which stand for rows of the body's nodes ---- */

/* One side of a link. */
typedef struct sbi_pair_side {
    const sb_contact *contact;
    const unsigned char *masked;
    const int *points;
    const sb_real *weights;
    int count;
} sbi_pair_side;

static sbi_pair_side sbi_pair_make_side(const sb_contact *contact, const unsigned char *masked, int face,
                                        const sb_real *weights)
{
    sbi_pair_side side;
    side.contact = contact;
    side.masked = masked;
    side.points = sbi_contact_face_nodes(contact->faces, face);
    side.weights = weights;
    side.count = contact->faces->sizes[face];
    return side;
}

SB_INLINE sb_vec3 sbi_pair_unmask(const unsigned char *masked, int node, sb_vec3 v)
{
    return masked && masked[node] ? sbi_contact_unmasked(masked[node], v) : v;
}

/* Mean of x [rows] without masked axes. */
static sb_vec3 sbi_pair_skin_mean(const sbi_pair_side *side, const sb_vec3 *x)
{
    sb_vec3 sum = {0, 0, 0};
    for (int a = 0; a < side->count; a++) {
        const sbi_contact_row row = sbi_contact_skin_row(&side->contact->skin, side->points[a]);
        for (int i = 0; i < row.count; i++)
            sum = sb_v3_madd(sum, side->weights[a] * row.weights[i],
                             sbi_pair_unmask(side->masked, row.nodes[i], x[row.nodes[i]]));
    }
    return sum;
}

static void sbi_pair_skin_subtract(const sbi_pair_side *side, sb_vec3 f, sb_vec3 *out)
{
    for (int a = 0; a < side->count; a++) {
        const sbi_contact_row row = sbi_contact_skin_row(&side->contact->skin, side->points[a]);
        for (int i = 0; i < row.count; i++)
            out[row.nodes[i]] = sb_v3_madd(out[row.nodes[i]], -side->weights[a] * row.weights[i],
                                           sbi_pair_unmask(side->masked, row.nodes[i], f));
    }
}

static double sbi_pair_multiply_skin(const sb_contact *contact, const unsigned char *masked, const sb_vec3 *x,
                                     sb_vec3 *out)
{
    const sbi_pairs *pairs = &contact->pairs;
    double sum = 0;
    for (int i = 0; i < pairs->link_count; i++) {
        const sbi_pair_link *link = pairs->links + i;
        const sbi_pair_sample *s = pairs->samples + link->sample;
        const sbi_pair_side one = sbi_pair_make_side(contact, masked, s->face, s->weights);
        const sbi_pair_side two = sbi_pair_make_side(contact, masked, s->other, s->shares);
        sb_vec3 x1 = sbi_pair_skin_mean(&one, x), x2 = sbi_pair_skin_mean(&two, x), f1 = sbi_pair_times(link, x2);
        sbi_pair_skin_subtract(&one, f1, out);
        sbi_pair_skin_subtract(&two, sbi_pair_times(link, x1), out);
        sum -= 2 * (double)sb_v3_dot(x1, f1);
    }
    return sum;
}

/* ---- the same between nodes of the body, by place: without looking for masked axes anew in each link ---- */

#if SBI_HAS_LANES
SBI_FORCE_INLINE sbi_pair_vector sbi_pair_pack(sb_vec3 v)
{
    const sbi_pair_vector packed = {v.x, v.y, v.z, 0};
    return packed;
}
SBI_FORCE_INLINE sb_vec3 sbi_pair_unpack(sbi_pair_vector v) { return sb_v3(v[0], v[1], v[2]); }
SBI_FORCE_INLINE sbi_pair_vector sbi_pair_madd(sbi_pair_vector a, sb_real s, sbi_pair_vector b) { return a + s * b; }
#else
SBI_FORCE_INLINE sbi_pair_vector sbi_pair_pack(sb_vec3 v) { return v; }
SBI_FORCE_INLINE sb_vec3 sbi_pair_unpack(sbi_pair_vector v) { return v; }
SBI_FORCE_INLINE sbi_pair_vector sbi_pair_madd(sbi_pair_vector a, sb_real s, sbi_pair_vector b)
{
    return sb_v3_madd(a, s, b);
}
#endif

SBI_FORCE_INLINE sb_vec3 sbi_pair_mean_of(const int *places, const sb_real *weights, int count,
                                          const sbi_pair_vector *x)
{
    sbi_pair_vector sum = sbi_pair_pack(sb_v3(0, 0, 0));
    for (int a = 0; a < count; a++)
        sum = sbi_pair_madd(sum, weights[a], x[places[a]]);
    return sbi_pair_unpack(sum);
}

SBI_FORCE_INLINE void sbi_pair_subtract_of(const int *places, const sb_real *weights, int count, sb_vec3 force,
                                           sbi_pair_vector *out)
{
    const sbi_pair_vector f = sbi_pair_pack(force);
    for (int a = 0; a < count; a++)
        out[places[a]] = sbi_pair_madd(out[places[a]], -weights[a], f);
}

/* Of nodes of both faces as many as given. Returns x.Cx of the link. */
SBI_FORCE_INLINE double sbi_pair_multiply_link(const sb_contact *contact, const sbi_pair_link *link, int count,
                                               int other_count)
{
    const sbi_pairs *pairs = &contact->pairs;
    const sbi_pair_sample *s = pairs->samples + link->sample;
    const int *places = pairs->patches[s->patch].nodes;
    const sb_vec3 x1 = sbi_pair_mean_of(places, s->weights, count, pairs->link_in);
    const sb_vec3 x2 = sbi_pair_mean_of(s->other_nodes, s->shares, other_count, pairs->link_in);
    const sb_vec3 f1 = sbi_pair_times(link, x2);
    sbi_pair_subtract_of(places, s->weights, count, f1, pairs->link_out);
    sbi_pair_subtract_of(s->other_nodes, s->shares, other_count, sbi_pair_times(link, x1), pairs->link_out);
    return -2 * (double)sb_v3_dot(x1, f1);
}

/* From the body's nodes to places, and back without masked axes. */
static void sbi_pair_take_nodes(const sbi_pairs *pairs, const unsigned char *masked, const sb_vec3 *x,
                                const sb_vec3 *out)
{
    for (int k = 0; k < pairs->link_node_count; k++) {
        const int node = pairs->link_nodes[k];
        pairs->link_in[k] = sbi_pair_pack(sbi_pair_unmask(masked, node, x[node]));
        pairs->link_out[k] = sbi_pair_pack(out[node]);
    }
}

static void sbi_pair_give_nodes(const sbi_pairs *pairs, const unsigned char *masked, sb_vec3 *out)
{
    for (int k = 0; k < pairs->link_node_count; k++) {
        const int node = pairs->link_nodes[k];
        const sb_vec3 sum = sbi_pair_unpack(pairs->link_out[k]);
        out[node] = masked && masked[node] ? sbi_body_pick_axes(masked[node], out[node], sum) : sum;
    }
}

SBI_API double sbi_pairs_multiply_links(void *user, const unsigned char *masked, const sb_vec3 *x, sb_vec3 *out)
{
    const sb_contact *contact = (const sb_contact *)user;
    const sbi_pairs *pairs = &contact->pairs;
    const unsigned char *sizes = contact->faces->sizes;
    double sum = 0;
    if (pairs->link_count == 0)
        return 0;
    if (contact->skin.source)
        return sbi_pair_multiply_skin(contact, masked, x, out);
    sbi_pair_take_nodes(pairs, masked, x, out);
    for (int i = 0; i < pairs->link_count; i++) {
        const sbi_pair_sample *s = pairs->samples + pairs->links[i].sample;
        const int count = sizes[s->face], other_count = sizes[s->other];
        if (count == 3 && other_count == 3) /* loops of known length */
            sum += sbi_pair_multiply_link(contact, pairs->links + i, 3, 3);
        else
            sum += sbi_pair_multiply_link(contact, pairs->links + i, count, other_count);
    }
    sbi_pair_give_nodes(pairs, masked, out);
    return sum;
}
