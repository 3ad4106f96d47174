/* cut_stroke: a blade that cuts as it moves.
 *
 * The front is where the blade's edge was: samples at its corners, and wherever it goes through a face of a cell.
 * Between calls they move with the material that they are in, and what is between two of them, in one cell, as straight
 * as it was (in elements with curved edges, in one micro-tet of the lattice, as which links see it); outside of the
 * tissue they stay where they are. So the next strip begins exactly where the last one ended,
 * however the tissue has moved, but for the rounding of places: cut_ring.c closes what that may leave. Tissue that
 * moves against a blade at rest is cut as well. */
#include "cut_private.h"

#include <string.h>

#include "../base/sort.h"

enum {
    SBI_CUT_SAMPLES = 384,    /* of a stroke, that there is room for from the start */
    SBI_CUT_MOST_EDGE = 65536 /* corners */
};

/* ---- memory ---- */

SBI_API int sbi_cut_stroke_reserve(const sb_cut *cut, sbi_cut_stroke *stroke, int samples)
{
    void *of = stroke->samples;
    int grown = sbi_cut_grow(&cut->allocator, &of, &stroke->sample_capacity, stroke->sample_count,
                             samples - stroke->sample_count, sizeof *stroke->samples);
    stroke->samples = (sbi_cut_sample *)of;
    return grown;
}

/* Room for a front of so many samples besides the `kept` ones that are there. */
static int sbi_cut_reserve_front(sb_cut *cut, int kept, int more)
{
    void *front = cut->front, *sorted = cut->sorted_front;
    const sb_allocator *allocator = &cut->allocator;
    int grown = sbi_cut_grow(allocator, &front, &cut->front_capacity, kept, more, sizeof *cut->front) &&
                sbi_cut_grow(allocator, &sorted, &cut->sorted_front_capacity, 0, kept + more, sizeof *cut->front);
    cut->front = (sbi_cut_sample *)front;
    cut->sorted_front = (sbi_cut_sample *)sorted;
    return grown && sbi_cut_list_grow(cut, &cut->front_order, kept + more) &&
           sbi_cut_list_grow(cut, &cut->front_scratch, kept + more);
}

static int sbi_cut_add_span(sb_cut *cut, const sb_real stretch[2])
{
    void *spans = cut->spans;
    int grown = sbi_cut_grow(&cut->allocator, &spans, &cut->span_capacity, cut->span_count, 1, sizeof *cut->spans);
    cut->spans = (sbi_cut_span *)spans;
    if (!grown)
        return 0;
    cut->spans[cut->span_count].first = stretch[0];
    cut->spans[cut->span_count++].last = stretch[1];
    return 1;
}

static int sbi_cut_reserve_strip(sb_cut *cut, int samples)
{
    void *strip = cut->strip;
    int grown = sbi_cut_grow(&cut->allocator, &strip, &cut->strip_capacity, 0, 6 * samples, sizeof *cut->strip);
    cut->strip = (sb_vec3 *)strip;
    return grown;
}

SBI_API int sbi_cut_take_strokes(sb_cut *cut, int max_strokes)
{
    void *spans = NULL;
    int taken = sbi_cut_reserve_front(cut, 0, SBI_CUT_SAMPLES) && sbi_cut_reserve_strip(cut, SBI_CUT_SAMPLES) &&
                sbi_cut_grow(&cut->allocator, &spans, &cut->span_capacity, 0, SBI_CUT_SAMPLES, sizeof *cut->spans);
    cut->spans = (sbi_cut_span *)spans;
    cut->strokes = (sbi_cut_stroke *)sbi_alloc_zeroed(&cut->allocator, (size_t)max_strokes, sizeof *cut->strokes);
    cut->max_strokes = cut->strokes ? max_strokes : 0;
    for (int i = 0; i < cut->max_strokes && taken; i++)
        taken = sbi_cut_stroke_reserve(cut, cut->strokes + i, SBI_CUT_SAMPLES);
    return taken && cut->strokes;
}

SBI_API void sbi_cut_free_strokes(sb_cut *cut)
{
    for (int i = 0; i < cut->max_strokes; i++)
        sbi_free(&cut->allocator, cut->strokes[i].samples);
    sbi_free(&cut->allocator, cut->strokes);
    sbi_free(&cut->allocator, cut->front);
    sbi_free(&cut->allocator, cut->sorted_front);
    sbi_free(&cut->allocator, cut->strip);
    sbi_free(&cut->allocator, cut->spans);
    sbi_free(&cut->allocator, cut->front_order.items);
    sbi_free(&cut->allocator, cut->front_scratch.items);
}

/* ---- samples in the tissue ---- */

/* The piece of a tet that has the material at these barycentrics. */
static int sbi_cut_piece_at(const sb_cut *cut, int tet, const sb_real at[4])
{
    int piece = tet;
    uint64_t points;
    sbi_parted parted;
    if (cut->pieces[tet].next < 0)
        return tet;
    sbi_parted_make(&cut->lattice, &cut->links, cut->tets + 4 * (size_t)tet, tet, &parted);
    points = parted.pieces[sbi_parted_piece_at(&parted, at)]; /* there are several pieces */
    while (cut->pieces[piece].next >= 0 && !(cut->pieces[piece].points & points))
        piece = cut->pieces[piece].next;
    return piece;
}

/* Parts of an element that stay straight: a tet4, or the micro-tets of one with curved edges. */
static int sbi_cut_brick_count(const sb_cut *cut) { return cut->nodes_per_tet == 4 ? 1 : cut->lattice.micro_count; }

/* The same as a number of them along an edge. */
static int sbi_cut_bricks_along(const sb_cut *cut) { return cut->nodes_per_tet == 4 ? 1 : cut->lattice.intervals; }

/* Where the corners of a brick of a piece are now. */
static void sbi_cut_corners(const sb_cut *cut, int tet, int piece, int brick, sb_vec3 corners[4])
{
    sbi_corner_order order;
    sb_vec3 x[SBI_CUT_NODES];
    sbi_cut_get_nodes(cut, piece, x);
    if (cut->nodes_per_tet == 4) {
        memcpy(corners, x, 4 * sizeof *corners);
        return;
    }
    order = sbi_corner_order_make(cut->tets + 4 * (size_t)tet);
    for (int a = 0; a < 4; a++) {
        sb_real at[4];
        sbi_lattice_point(&cut->lattice, cut->lattice.micros[brick][a], at);
        corners[a] = sbi_cut_place(cut, &order, at, x);
    }
}

/* Barycentrics in the tet of a point of a brick. */
static void sbi_cut_from_brick(const sb_cut *cut, int brick, const sb_real of_brick[4], sb_real at[4])
{
    if (cut->nodes_per_tet == 4) {
        memcpy(at, of_brick, 4 * sizeof *at);
        return;
    }
    at[0] = at[1] = at[2] = at[3] = 0;
    for (int a = 0; a < 4; a++) {
        sb_real corner[4];
        sbi_lattice_point(&cut->lattice, cut->lattice.micros[brick][a], corner);
        for (int k = 0; k < 4; k++)
            at[k] += of_brick[a] * corner[k];
    }
}

/* The brick that has a point of the tet deepest inside, and its barycentrics there. */
static int sbi_cut_to_brick(const sb_cut *cut, const sb_real at[4], sb_real of_brick[4])
{
    sb_real deepest = -SB_REAL_MAX;
    int found = 0;
    memcpy(of_brick, at, 4 * sizeof *at);
    for (int brick = 0; brick < cut->lattice.micro_count && cut->nodes_per_tet > 4; brick++) {
        sb_vec3 corners[4];
        sb_real own[4], depth;
        for (int a = 0; a < 4; a++) {
            sb_real corner[4];
            sbi_lattice_point(&cut->lattice, cut->lattice.micros[brick][a], corner);
            corners[a] = sb_v3(corner[1], corner[2], corner[3]);
        }
        depth = sbi_lattice_barycentrics(corners, sb_v3(at[1], at[2], at[3]), own);
        if (!(depth > deepest))
            continue;
        deepest = depth;
        found = brick;
        memcpy(of_brick, own, sizeof own);
    }
    return found;
}

/* Where a sample is now. */
static sb_vec3 sbi_cut_carry(const sb_cut *cut, const sbi_cut_sample *sample)
{
    sb_vec3 x[4], place = {0, 0, 0};
    sb_real of_brick[4];
    int brick;
    if (sample->tet < 0 || sbi_cut_first_piece(cut, sample->tet) < 0)
        return sample->place;
    brick = sbi_cut_to_brick(cut, sample->at, of_brick);
    sbi_cut_corners(cut, sample->tet, sbi_cut_piece_at(cut, sample->tet, sample->at), brick, x);
    for (int a = 0; a < 4; a++)
        place = sb_v3_madd(place, of_brick[a], x[a]);
    return place;
}

/* Outside of the tissue a blade moves with the skin where it is no farther than that, in barycentrics of the cell:
 * tissue that comes upon it is cut from its skin on. */
static const sb_real sbi_cut_skin = 1;

/* Puts a sample at p into a piece where that has it deeper inside, or nearer, than by `deepest`, in barycentrics of the
 * cell. */
static void sbi_cut_settle(const sb_cut *cut, int tet, int piece, sb_vec3 p, sb_real *deepest, sbi_cut_sample *sample)
{
    for (int brick = 0; brick < sbi_cut_brick_count(cut); brick++) {
        sb_vec3 x[4];
        sb_real own[4], at[4], depth;
        sbi_cut_corners(cut, tet, piece, brick, x);
        depth = sbi_lattice_barycentrics(x, p, own) / (sb_real)sbi_cut_bricks_along(cut);
        if (!(depth > *deepest))
            continue;
        sbi_cut_from_brick(cut, brick, own, at);
        if (sbi_cut_piece_at(cut, tet, at) != piece)
            continue;
        *deepest = depth;
        sample->tet = tet;
        memcpy(sample->at, at, sizeof at);
    }
}

/* Puts a sample at p into the piece of one of these tets, whose box p is in or no farther from than `margin` (m), that
 * has it deepest inside, or nearest; returns how deep. */
static sb_real sbi_cut_settle_among(const sb_cut *cut, const sbi_cut_list *tets, sb_vec3 p, sb_real margin,
                                    sbi_cut_sample *sample)
{
    sbi_cut_box box = sbi_cut_box_around(&p, 1);
    sb_real deepest = -sbi_cut_skin;
    sbi_cut_box_widen(&box, margin);
    sample->tet = -1;
    for (int i = 0; i < tets->count; i++) {
        int tet = tets->items[i];
        if (!sbi_cut_meets_tet(cut, tet, &box))
            continue;
        for (int piece = sbi_cut_first_piece(cut, tet); piece >= 0; piece = cut->pieces[piece].next)
            sbi_cut_settle(cut, tet, piece, p, &deepest, sample);
    }
    return deepest;
}

/* A sample at a corner: in the piece of a near tet that has it deepest inside or nearest, or in space. */
static void sbi_cut_add_corner(sb_cut *cut, int corner, int corners, sb_vec3 p, int *count)
{
    sbi_cut_sample *sample = cut->front + (*count)++;
    memset(sample, 0, sizeof *sample);
    sample->side = sbi_min_int(corner, corners - 2);
    sample->along = corner == corners - 1;
    sample->place = p;
    if (sbi_cut_settle_among(cut, &cut->listed, p, 0, sample) < 0)
        (void)sbi_cut_settle_among(cut, &cut->near, p, cut->element_size, sample);
}

/* ---- the front along an edge ---- */

/* The stretch of a side from p to q that is in a tet with corners at x, or out of it by no more than `beyond` in
 * barycentrics, and barycentrics at its ends; 0: there is none. */
static int sbi_cut_clip(const sb_vec3 x[4], sb_vec3 p, sb_vec3 q, sb_real beyond, sb_real stretch[2], sb_real at[2][4])
{
    sb_real from[4], to[4];
    stretch[0] = 0;
    stretch[1] = 1;
    if (!(sbi_lattice_barycentrics(x, p, from) > -SB_REAL_MAX) || !(sbi_lattice_barycentrics(x, q, to) > -SB_REAL_MAX))
        return 0;
    for (int a = 0; a < 4; a++) {
        sb_real first = from[a] + beyond, last = to[a] + beyond;
        if (first < 0 && last < 0)
            return 0;
        if (first < 0)
            stretch[0] = sb_max(stretch[0], first / (first - last));
        else if (last < 0)
            stretch[1] = sb_min(stretch[1], first / (first - last));
    }
    for (int end = 0; end < 2; end++)
        for (int a = 0; a < 4; a++)
            at[end][a] = (1 - stretch[end]) * from[a] + stretch[end] * to[a];
    return stretch[0] < stretch[1];
}

static int sbi_cut_is_on_skin(const sb_cut *cut, int tet)
{
    const int *others = cut->neighbours.items + 4 * (size_t)tet;
    return others[0] < 0 || others[1] < 0 || others[2] < 0 || others[3] < 0;
}

/* Two samples on a side that are no farther apart than that are one. */
static const sb_real sbi_cut_apart = (sb_real)1e-6;

/* 1 when all of the side is in cells that it goes through: no sample of it is outside. */
static int sbi_cut_is_inside(const sb_cut *cut)
{
    sb_real reached = 0, last = -1;
    while (reached + sbi_cut_apart < 1 && reached > last) {
        last = reached;
        for (int i = 0; i < cut->span_count; i++)
            if (cut->spans[i].first <= reached + sbi_cut_apart)
                reached = sb_max(reached, cut->spans[i].last);
    }
    return reached + sbi_cut_apart >= 1;
}

/* 1 when a place of the side is in no cell that it goes through. */
static int sbi_cut_is_outside(const sb_cut *cut, sb_real along)
{
    for (int i = 0; i < cut->span_count; i++)
        if (along >= cut->spans[i].first && along <= cut->spans[i].last)
            return 0;
    return 1;
}

/* Adds where a side goes into and out of a brick of a piece that has the material there; beyond > 0: of what is near
 * its skin, outside of the tissue. The ends of the side are not of these. 0: no memory. */
static int sbi_cut_add_passes(sb_cut *cut, int piece, int brick, sb_real beyond, const sbi_cut_sample *side,
                              const sb_vec3 ends[2], int *count)
{
    sb_vec3 x[4];
    sb_real stretch[2], at[2][4];
    sbi_cut_corners(cut, side->tet, piece, brick, x);
    if (!sbi_cut_clip(x, ends[0], ends[1], beyond * (sb_real)sbi_cut_bricks_along(cut), stretch, at))
        return 1;
    if (!sbi_cut_reserve_front(cut, *count, 2) || (beyond == 0 && !sbi_cut_add_span(cut, stretch)))
        return 0;
    for (int end = 0; end < 2; end++) {
        sbi_cut_sample *sample = cut->front + *count;
        sb_real of_tet[4];
        sbi_cut_from_brick(cut, brick, at[end], of_tet);
        if (!(stretch[end] > 0) || !(stretch[end] < 1) || sbi_cut_piece_at(cut, side->tet, of_tet) != piece ||
            (beyond > 0 && !sbi_cut_is_outside(cut, stretch[end])))
            continue;
        *sample = *side;
        sample->along = stretch[end];
        sample->place = sb_v3_madd(sb_v3_scale(1 - stretch[end], ends[0]), stretch[end], ends[1]);
        memcpy(sample->at, of_tet, sizeof of_tet);
        (*count)++;
    }
    return 1;
}

/* Adds samples of a side where it goes through the cells of these tets, or, beyond > 0, past their skin outside of the
 * tissue. 0: no memory. */
static int sbi_cut_add_among(sb_cut *cut, const sbi_cut_list *tets, sb_real beyond, const sb_vec3 ends[2], int side,
                             int *count)
{
    sbi_cut_box box = sbi_cut_box_around(ends, 2);
    sbi_cut_sample passing;
    memset(&passing, 0, sizeof passing);
    passing.side = side;
    if (beyond > 0)
        sbi_cut_box_widen(&box, cut->element_size);
    for (int i = 0; i < tets->count; i++) {
        int tet = passing.tet = tets->items[i];
        if ((beyond > 0 && !sbi_cut_is_on_skin(cut, tet)) || !sbi_cut_meets_tet(cut, tet, &box))
            continue;
        for (int piece = sbi_cut_first_piece(cut, tet); piece >= 0; piece = cut->pieces[piece].next)
            for (int brick = 0; brick < sbi_cut_brick_count(cut); brick++)
                if (!sbi_cut_add_passes(cut, piece, brick, beyond, &passing, ends, count))
                    return 0;
    }
    return 1;
}

/* Adds the samples of a side that are not corners; 0: no memory. */
static int sbi_cut_add_side(sb_cut *cut, const sb_vec3 ends[2], int side, int *count)
{
    cut->span_count = 0;
    return sbi_cut_add_among(cut, &cut->listed, 0, ends, side, count) &&
           (sbi_cut_is_inside(cut) || sbi_cut_add_among(cut, &cut->near, sbi_cut_skin, ends, side, count));
}

/* Lists the near tets that the edge may go through: few, where the next strip may reach many. */
static void sbi_cut_list_at_edge(sb_cut *cut, const sb_vec3 *edge, int corners)
{
    sbi_cut_box box = sbi_cut_box_around(edge, corners);
    cut->listed.count = 0;
    for (int i = 0; i < cut->near.count; i++)
        if (sbi_cut_meets_tet(cut, cut->near.items[i], &box))
            cut->listed.items[cut->listed.count++] = cut->near.items[i];
}

static int sbi_cut_is_sooner(const void *context, int a, int b)
{
    const sbi_cut_sample *front = (const sbi_cut_sample *)context;
    if (front[a].side != front[b].side)
        return front[a].side < front[b].side;
    return front[a].along < front[b].along;
}

/* Samples along an edge among the near tets, in cut->front; returns how many, 0: no memory. */
static int sbi_cut_find_front(sb_cut *cut, const sb_vec3 *edge, int corners)
{
    int count = 0, kept = 0;
    if (!sbi_cut_reserve_front(cut, 0, corners))
        return 0;
    sbi_cut_list_at_edge(cut, edge, corners);
    for (int k = 0; k < corners; k++)
        sbi_cut_add_corner(cut, k, corners, edge[k], &count);
    for (int side = 0; side + 1 < corners; side++)
        if (!sbi_cut_add_side(cut, edge + side, side, &count))
            return 0;
    for (int i = 0; i < count; i++)
        cut->front_order.items[i] = i;
    sbi_merge_sort(cut->front_order.items, cut->front_scratch.items, count, sbi_cut_is_sooner, cut->front);
    for (int i = 0; i < count; i++) {
        const sbi_cut_sample *next = cut->front + cut->front_order.items[i];
        const sbi_cut_sample *last = kept ? cut->sorted_front + kept - 1 : NULL;
        int is_corner = next->along == 0 || next->along == 1;
        if (is_corner || !last || last->side != next->side || next->along - last->along > sbi_cut_apart)
            cut->sorted_front[kept++] = *next;
    }
    return kept;
}

/* The front of a stroke is the one that was found. */
static void sbi_cut_take_front(const sb_cut *cut, sbi_cut_stroke *stroke, int corners, int samples)
{
    memcpy(stroke->samples, cut->sorted_front, (size_t)samples * sizeof *stroke->samples);
    stroke->edge_count = corners;
    stroke->sample_count = samples;
}

static sb_vec3 sbi_cut_on_edge(const sb_vec3 *edge, const sbi_cut_sample *sample)
{
    const sb_vec3 *p = edge + sample->side;
    if (sample->along == 0 || sample->along == 1)
        return p[sample->along == 1];
    return sb_v3_madd(sb_v3_scale(1 - sample->along, p[0]), sample->along, p[1]);
}

/* Two triangles between each two samples, from where they are now to where the edge is. */
static void sbi_cut_make_strip(const sb_cut *cut, const sbi_cut_stroke *stroke, const sb_vec3 *edge, sb_vec3 *strip)
{
    sb_vec3 from = sbi_cut_carry(cut, stroke->samples), to = sbi_cut_on_edge(edge, stroke->samples);
    for (int i = 1; i < stroke->sample_count; i++, strip += 6) {
        strip[0] = strip[3] = from;
        strip[5] = to;
        from = sbi_cut_carry(cut, stroke->samples + i);
        to = sbi_cut_on_edge(edge, stroke->samples + i);
        strip[1] = from;
        strip[2] = strip[4] = to;
    }
}

/* ---- calls ---- */

static sb_result sbi_cut_check_edge(const sb_cut *cut, const sb_vec3 *edge, int count, sb_error *error)
{
    sb_result result = sbi_cut_check_use(cut, error);
    for (int k = 0; k < count && result == SB_OK; k++)
        if (!sb_v3_is_finite(edge[k]))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "corner %d of the edge is not finite", k);
    return result;
}

SB_API sb_result sb_cut_begin(sb_cut *cut, const sb_vec3 *edge, int count, int *stroke, sb_error *error)
{
    int at = 0, samples;
    sb_result result;
    if (!cut || !edge || !stroke || count < 2 || count > SBI_CUT_MOST_EDGE)
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "sb_cut_begin needs a cut, an edge of 2 to %d corners and a place for the stroke",
                        SBI_CUT_MOST_EDGE);
    result = sbi_cut_check_edge(cut, edge, count, error);
    if (result != SB_OK)
        return result;
    while (at < cut->max_strokes && cut->strokes[at].edge_count)
        at++;
    if (at == cut->max_strokes)
        return sbi_fail(error, SB_ERROR_STATE, "all %d strokes of def.max_strokes are under way", cut->max_strokes);
    sbi_cut_list_reached(cut, edge, count, cut->element_size);
    samples = sbi_cut_find_front(cut, edge, count);
    if (!samples || !sbi_cut_stroke_reserve(cut, cut->strokes + at, samples))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a stroke with %d corners", count);
    sbi_cut_take_front(cut, cut->strokes + at, count, samples);
    *stroke = at;
    sbi_cut_tell(cut, SBI_CUT_BEGIN, at, edge, count);
    return SB_OK;
}

/* A stroke that goes on, with the edge that its blade has now. */
static sb_result sbi_cut_check_move(const sb_cut *cut, int stroke, const sb_vec3 *edge, sb_error *error)
{
    if (stroke < 0 || stroke >= cut->max_strokes || !cut->strokes[stroke].edge_count)
        return sbi_fail(error, SB_ERROR_INDEX, "there is no stroke %d under way", stroke);
    return sbi_cut_check_edge(cut, edge, cut->strokes[stroke].edge_count, error);
}

/* Takes the edge of a stroke to where it is now, and cuts what lies between, or, cuts 0, nothing. */
static sb_result sbi_cut_go_on(sb_cut *cut, sbi_cut_stroke *stroke, const sb_vec3 *edge, int cuts, sb_cut_info *info,
                               sb_error *error)
{
    int samples, triangles = cuts ? 2 * (stroke->sample_count - 1) : 0;
    sb_result result;
    if (!sbi_cut_reserve_strip(cut, stroke->sample_count))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the samples of a stroke");
    sbi_cut_make_strip(cut, stroke, edge, cut->strip);
    if (cuts)
        sbi_cut_list_reached(cut, cut->strip, 3 * triangles, cut->element_size);
    else
        sbi_cut_list_reached(cut, edge, stroke->edge_count, cut->element_size);
    samples = sbi_cut_find_front(cut, edge, stroke->edge_count);
    if (!samples || !sbi_cut_stroke_reserve(cut, stroke, samples))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the samples of a stroke");
    result = sbi_cut_along(cut, cut->strip, triangles, cuts ? stroke : NULL, info, error);
    if (result == SB_OK)
        sbi_cut_take_front(cut, stroke, stroke->edge_count, samples);
    return result;
}

SB_API sb_result sb_cut_move(sb_cut *cut, int stroke, const sb_vec3 *edge, sb_cut_info *info, sb_error *error)
{
    sbi_cut_stroke *of;
    sb_result result;
    if (!cut || !edge)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_cut_move needs a cut and an edge");
    result = sbi_cut_check_move(cut, stroke, edge, error);
    if (result != SB_OK)
        return result;
    of = cut->strokes + stroke;
    of->about = edge[0];
    result = sbi_cut_go_on(cut, of, edge, 1, info, error);
    if (result == SB_OK)
        sbi_cut_tell(cut, SBI_CUT_MOVE, stroke, edge, of->edge_count);
    return result;
}

/* ---- scissors: the edge goes from one tip to the hinge and on to the other tip ---- */

enum { SBI_CUT_HINGE = 1, SBI_CUT_SCISSORS_CORNERS = 3 };

/* How far scissors are open: the distance of their blades at length 1, and how one has to turn to the other. Of blades
 * without length: not at all. */
static sb_real sbi_cut_opening(const sb_vec3 edge[SBI_CUT_SCISSORS_CORNERS], sb_vec3 *turn)
{
    sb_vec3 a = sb_v3_sub(edge[0], edge[SBI_CUT_HINGE]), b = sb_v3_sub(edge[2], edge[SBI_CUT_HINGE]);
    sb_real of_a = sb_v3_norm(a), of_b = sb_v3_norm(b);
    *turn = sb_v3(0, 0, 0);
    if (!(of_a > 0) || !(of_b > 0))
        return 0;
    a = sb_v3_scale(1 / of_a, a);
    b = sb_v3_scale(1 / of_b, b);
    *turn = sb_v3_cross(a, b);
    return sb_v3_norm(sb_v3_sub(a, b));
}

/* Where the corners of a stroke of scissors were at the last call. */
static void sbi_cut_last_edge(const sbi_cut_stroke *stroke, sb_vec3 edge[SBI_CUT_SCISSORS_CORNERS])
{
    for (int i = 0; i < stroke->sample_count; i++) {
        const sbi_cut_sample *sample = stroke->samples + i;
        if (sample->along == 0 || sample->along == 1)
            edge[sample->side + (sample->along == 1)] = sample->place;
    }
}

/* 1 when scissors close: their blades are nearer to each other than at the last call, or have passed each other. */
static int sbi_cut_closes(const sbi_cut_stroke *stroke, const sb_vec3 edge[SBI_CUT_SCISSORS_CORNERS])
{
    const sb_real rounding = 64 * SB_EPSILON;
    sb_vec3 last[SBI_CUT_SCISSORS_CORNERS], turn, last_turn;
    sb_real opening, last_opening;
    memcpy(last, edge, sizeof last);
    sbi_cut_last_edge(stroke, last);
    opening = sbi_cut_opening(edge, &turn);
    last_opening = sbi_cut_opening(last, &last_turn);
    return opening < last_opening - rounding || (last_opening > rounding && sb_v3_dot(turn, last_turn) < 0);
}

SB_API sb_result sb_cut_scissors(sb_cut *cut, int stroke, sb_vec3 hinge, const sb_vec3 tips[2], sb_cut_info *info,
                                 sb_error *error)
{
    sb_vec3 edge[SBI_CUT_SCISSORS_CORNERS];
    sbi_cut_stroke *of;
    sb_result result;
    if (!cut || !tips)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_cut_scissors needs a cut and two tips");
    edge[0] = tips[0], edge[SBI_CUT_HINGE] = hinge, edge[2] = tips[1];
    if (stroke >= 0 && stroke < cut->max_strokes && cut->strokes[stroke].edge_count &&
        cut->strokes[stroke].edge_count != SBI_CUT_SCISSORS_CORNERS)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "stroke %d has %d corners: scissors have 3, tip, hinge and tip",
                        stroke, cut->strokes[stroke].edge_count);
    result = sbi_cut_check_move(cut, stroke, edge, error);
    if (result != SB_OK)
        return result;
    of = cut->strokes + stroke;
    of->about = hinge;
    result = sbi_cut_go_on(cut, of, edge, sbi_cut_closes(of, edge), info, error);
    if (result == SB_OK)
        sbi_cut_tell(cut, SBI_CUT_SCISSORS, stroke, edge, SBI_CUT_SCISSORS_CORNERS);
    return result;
}

SB_API void sb_cut_end(sb_cut *cut, int stroke)
{
    if (!cut || stroke < 0 || stroke >= cut->max_strokes || !cut->strokes[stroke].edge_count)
        return;
    cut->strokes[stroke].edge_count = cut->strokes[stroke].sample_count = cut->strokes[stroke].debts.count = 0;
    sbi_cut_tell(cut, SBI_CUT_END, stroke, NULL, 0);
}
