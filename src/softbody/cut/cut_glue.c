/* cut_glue: what holds the lips of a cut together that no blade has come through yet.
 *
 * Each triangle of such a lip ties its two sides at its centroid q: energy k/2 |j|^2 with the jump j = sum_a N_a(q)
 * (x_a^+ - x_a^-), k = beta (lambda + 2 mu) A / h, A the area of the triangle and h = (6 V)^(1/3) of the element, at
 * rest: a central force between two points of the material in one place, which takes no momentum and no moment, and
 * nothing from a rigid motion of both. It is released once a blade has passed the needle through q, of h/2 to either
 * side in the present shape, or once blades have parted its two sides within its micro-tet: beside a curved way they
 * pass farther off. So what blades have cut through altogether is free.
 * Of tet10 k is 0.4 of that: there the jump is held at more nodes. Measured on the half-cut beam of 21 x 4 x 7 cubes
 * and the edge-cracked plate of 11 and 21 cells (tests/test_cut_quad.c), errors of sag, force and stress intensities
 * are with 1.0 -3.1, 2.2, -1.9 and -1.5 %, with 0.4 -1.4, 0.7, 1.0 and -0.1 %, with 0.2 0.4, -0.9, 4.0 and 1.4 %. Those
 * of one pair of pieces are one tie of the body, with the sum of their Gram matrices.
 *
 * Source: the penalty of Suwelack (2014), 8.3.5, between parts of an element that is parted ahead of the blade. */
#include "cut_private.h"

#include <string.h>

/* Triangles and tets that there is room for from the start. */
enum { SBI_CUT_GLUED_TETS = 256, SBI_CUT_GLUED = SBI_CUT_GLUED_TETS * (int)SBI_LIPS };

/* ---- memory ---- */

SBI_API int sbi_cut_reserve_glue(sb_cut *cut, int count)
{
    void *glue = cut->glue, *next = cut->next_glue;
    int grown = sbi_cut_grow(&cut->allocator, &glue, &cut->glue_capacity, cut->glue_count, count - cut->glue_count,
                             sizeof *cut->glue) &&
                sbi_cut_grow(&cut->allocator, &next, &cut->next_glue_capacity, cut->next_glue_count,
                             count - cut->next_glue_count, sizeof *cut->next_glue);
    cut->glue = (sbi_cut_glued *)glue;
    cut->next_glue = (sbi_cut_glued *)next;
    return grown;
}

static int sbi_cut_reserve_seams(sb_cut *cut, int more)
{
    void *seams = cut->seams;
    int grown = sbi_cut_grow(&cut->allocator, &seams, &cut->seam_capacity, cut->seam_count, more, sizeof *cut->seams);
    cut->seams = (sbi_cut_seam *)seams;
    return grown;
}

static int sbi_cut_reserve_ties(sb_cut *cut, int more)
{
    void *ties = cut->ties;
    int grown = sbi_cut_grow(&cut->allocator, &ties, &cut->tie_capacity, cut->tie_count, more, sizeof *cut->ties);
    cut->ties = (sbi_glue_tie *)ties;
    return grown;
}

SBI_API int sbi_cut_take_glue(sb_cut *cut)
{
    if (!cut->glues) /* triangles of one tet at a time are looked at */
        return sbi_cut_reserve_seams(cut, SBI_LIPS * cut->lattice.micro_count);
    return sbi_cut_reserve_glue(cut, SBI_CUT_GLUED) && sbi_cut_reserve_seams(cut, SBI_CUT_GLUED) &&
           sbi_cut_reserve_ties(cut, SBI_CUT_GLUED_TETS) &&
           sbi_live_reserve_glue(cut->body, SBI_CUT_GLUED_TETS, NULL) == SB_OK;
}

SBI_API void sbi_cut_free_glue(sb_cut *cut)
{
    sbi_free(&cut->allocator, cut->glue);
    sbi_free(&cut->allocator, cut->next_glue);
    sbi_free(&cut->allocator, cut->seams);
    sbi_free(&cut->allocator, cut->ties);
}

/* ---- triangles ---- */

/* A triangle at rest. */
typedef struct sbi_cut_facet {
    sb_real middle[4];            /* barycentrics of the centroid */
    sb_real shape[SBI_CUT_NODES]; /* shape functions there */
    sb_real area;                 /* m^2 */
    sb_real firmness;             /* beta A / h (m) */
    sb_real size;                 /* h (m) */
} sbi_cut_facet;

/* Normal of a triangle with these corners, as long as twice its area. */
static sb_vec3 sbi_cut_facet_normal(const sb_cut *cut, const sbi_corner_order *order, const sbi_lip *lip,
                                    const sb_vec3 x[SBI_CUT_NODES])
{
    sb_vec3 a = sbi_cut_place(cut, order, lip->corners[0], x);
    return sb_v3_cross(sb_v3_sub(sbi_cut_place(cut, order, lip->corners[1], x), a),
                       sb_v3_sub(sbi_cut_place(cut, order, lip->corners[2], x), a));
}

static sbi_cut_facet sbi_cut_facet_make(const sb_cut *cut, int tet, const sbi_parted *parted, const sbi_lip *lip)
{
    const sb_real of_tet10 = (sb_real)0.4;
    const int *nodes = sbi_cut_tet_nodes(cut, tet);
    sbi_cut_facet facet;
    sb_vec3 x[SBI_CUT_NODES];
    for (int a = 0; a < cut->nodes_per_tet; a++)
        x[a] = cut->body->reference[nodes[a]];
    for (int a = 0; a < 4; a++)
        facet.middle[a] = (lip->corners[0][a] + lip->corners[1][a] + lip->corners[2][a]) / 3;
    sbi_cut_get_shape(cut, facet.middle, facet.shape);
    facet.size = sb_cbrt(sb_v3_dot(sb_v3_cross(sb_v3_sub(x[1], x[0]), sb_v3_sub(x[2], x[0])), sb_v3_sub(x[3], x[0])));
    facet.area = sb_v3_norm(sbi_cut_facet_normal(cut, &parted->order, lip, x)) / 2;
    facet.firmness = cut->beta * facet.area / facet.size * (cut->nodes_per_tet == 4 ? 1 : of_tet10);
    return facet;
}

/* 1 when no blade has parted the two ends of a link within a micro-tet: they hang together over links that none has
 * crossed. */
static int sbi_cut_is_ahead(const sbi_parted *parted, int micro, int link)
{
    const unsigned char *links = parted->lattice->micro_links[micro], *ends = parted->lattice->links[link];
    uint64_t reached = (uint64_t)1 << ends[0], before = 0;
    while (reached != before) {
        before = reached;
        for (int e = 0; e < 6; e++) {
            const unsigned char *to = parted->lattice->links[links[e]];
            if (parted->cut[links[e]] != SBI_LINK_CUT && (reached >> to[0] & 1) != (reached >> to[1] & 1))
                reached |= (uint64_t)1 << to[0] | (uint64_t)1 << to[1];
        }
    }
    return (int)(reached >> ends[1] & 1);
}

/* Needle, energy and part of a seam in the present shape: of the mean of its two sides before the call. */
static void sbi_cut_measure_seam(const sb_cut *cut, const sbi_parted *parted, const sbi_lip *lip,
                                 const sbi_cut_facet *facet, sbi_cut_seam *seam)
{
    const unsigned char *ends = cut->lattice.links[lip->link];
    const int *below = sbi_cut_piece_nodes(cut, sbi_cut_piece_with(cut, seam->tet, ends[0]));
    const int *above = sbi_cut_piece_nodes(cut, sbi_cut_piece_with(cut, seam->tet, ends[1]));
    const sb_material *material = cut->body->materials + cut->body->cell_material[cut->pieces[seam->tet].cell];
    sb_vec3 x[SBI_CUT_NODES], jump = sb_v3(0, 0, 0), middle, normal;
    sb_real size;
    for (int a = 0; a < cut->nodes_per_tet; a++) {
        sb_vec3 p = cut->body->position[below[a]], q = cut->body->position[above[a]];
        x[a] = sb_v3_scale((sb_real)0.5, sb_v3_add(p, q));
        jump = sb_v3_madd(jump, facet->shape[a], sb_v3_sub(p, q));
    }
    middle = sbi_cut_place(cut, &parted->order, facet->middle, x);
    normal = sbi_cut_facet_normal(cut, &parted->order, lip, x);
    size = sb_v3_norm(normal);
    normal = size > 0 ? sb_v3_scale(facet->size / (2 * size), normal) : sb_v3(0, 0, 0);
    seam->needle[0] = sb_v3_sub(middle, normal);
    seam->needle[1] = sb_v3_add(middle, normal);
    seam->part = cut->body->node_component[below[0]];
    seam->energy = facet->firmness * (material->lambda + 2 * material->mu) / 2 * sb_v3_dot(jump, jump);
}

/* ---- after a call ---- */

/* Items of cut->glue that are of one tet. */
typedef struct sbi_cut_span_of_glue {
    int first, end;
} sbi_cut_span_of_glue;

static int sbi_cut_is_glued(const sb_cut *cut, const sbi_cut_span_of_glue *span, int place)
{
    int is_glued = 0;
    for (int i = span->first; i < span->end && !is_glued; i++)
        is_glued = cut->glue[i].place == place;
    return is_glued;
}

/* One triangle of a tet that is glued or has parted. */
static void sbi_cut_list_seam(sb_cut *cut, const sbi_parted *parted, const sbi_cut_span_of_glue *span, int tet,
                              int micro, const sbi_lip *lip)
{
    sbi_cut_seam *seam = cut->seams + cut->seam_count;
    sbi_cut_facet facet = sbi_cut_facet_make(cut, tet, parted, lip);
    const unsigned char *ends = cut->lattice.links[lip->link];
    seam->tet = tet;
    seam->place = SBI_LIPS * micro + lip->place;
    seam->link = lip->link;
    memcpy(seam->at, facet.middle, sizeof seam->at);
    seam->area = facet.area;
    seam->is_swept = 0;
    seam->is_new = (cut->pieces[sbi_cut_piece_with(cut, tet, ends[0])].points >> ends[1] & 1) != 0;
    if (!seam->is_new && !sbi_cut_is_glued(cut, span, seam->place))
        return;
    sbi_cut_measure_seam(cut, parted, lip, &facet, seam);
    if (facet.area > 0 && sbi_cut_is_ahead(parted, micro, lip->link)) {
        cut->seam_count++;
        return;
    }
    cut->released.area += facet.area;
    cut->released.energy += seam->is_new ? 0 : seam->energy;
    sbi_cut_add_freed(cut, seam);
}

static int sbi_cut_list_tet(sb_cut *cut, const sbi_cut_span_of_glue *span, int tet)
{
    sbi_parted parted;
    sbi_lip lips[SBI_LIPS];
    sbi_parted_make(&cut->lattice, &cut->links, cut->tets + 4 * (size_t)tet, tet, &parted);
    if (!sbi_cut_reserve_seams(cut, SBI_LIPS * cut->lattice.micro_count) ||
        !sbi_cut_reserve_freed(cut, SBI_LIPS * cut->lattice.micro_count))
        return 0;
    for (int micro = 0; micro < cut->lattice.micro_count; micro++) {
        int count = sbi_parted_lips(&parted, micro, lips);
        for (int pass = 0; pass < SBI_LIPS && count; pass++) /* in the order of their places */
            for (int k = 0; k < count; k++)
                if (lips[k].place == pass)
                    sbi_cut_list_seam(cut, &parted, span, tet, micro, lips + k);
    }
    return 1;
}

SBI_API int sbi_cut_list_seams(sb_cut *cut)
{
    sbi_cut_span_of_glue span = {0, 0};
    memset(&cut->released, 0, sizeof cut->released);
    cut->seam_count = cut->freed.count = 0;
    if (!cut->listed.count && !cut->glue_count)
        return 1;
    for (int tet = 0; tet < cut->tet_count; tet++) {
        span.first = span.end;
        while (span.end < cut->glue_count && cut->glue[span.end].tet == tet)
            span.end++;
        if ((span.first < span.end || (cut->tet_marks[tet] & SBI_CUT_PARTED)) && !sbi_cut_list_tet(cut, &span, tet))
            return 0;
    }
    return 1;
}

SBI_API int sbi_cut_sweep_seams(sb_cut *cut, const sbi_crossing_frame *frame, int part)
{
    for (int i = 0; i < cut->seam_count; i++) {
        sbi_cut_seam *seam = cut->seams + i;
        if (part == SBI_CUT_ALL_PARTS || seam->part == part)
            seam->is_swept |= sbi_cut_first_crossing(cut, sbi_crossing_round(frame, seam->needle[0]),
                                                     sbi_crossing_round(frame, seam->needle[1])) >= 0;
    }
    return 1;
}

SBI_API int sbi_cut_keep_seams(sb_cut *cut)
{
    if (!sbi_cut_reserve_glue(cut, cut->seam_count) || !sbi_cut_reserve_freed(cut, cut->seam_count))
        return 0;
    cut->next_glue_count = 0;
    for (int i = 0; i < cut->seam_count; i++) {
        const sbi_cut_seam *seam = cut->seams + i;
        if (seam->is_swept) {
            cut->released.area += seam->area;
            cut->released.energy += seam->is_new ? 0 : seam->energy;
            sbi_cut_add_freed(cut, seam);
            continue;
        }
        cut->released.glued_area += seam->area;
        cut->next_glue[cut->next_glue_count].tet = seam->tet;
        cut->next_glue[cut->next_glue_count++].place = seam->place;
    }
    return 1;
}

/* ---- ties ---- */

/* The cell of a piece as it is after the call. */
static int sbi_cut_next_cell(const sb_cut *cut, int tet, int piece)
{
    int at = tet;
    if (cut->cell_of[tet])
        return cut->cells[cut->cell_of[tet] - 1 + piece].cell;
    for (; piece > 0 && cut->pieces[at].next >= 0; piece--)
        at = cut->pieces[at].next;
    return cut->pieces[at].cell;
}

/* The tie of two pieces of a tet, among those from `first` on, which are in the order of their pieces; there is room
 * for one more. pieces[]: of each tie. */
static sbi_glue_tie *sbi_cut_find_tie(sb_cut *cut, int tet, const sbi_lip *lip, int first, int *pieces)
{
    int low = sbi_min_int(lip->below, lip->above), high = sbi_max_int(lip->below, lip->above), at = first;
    int name = SBI_LATTICE_POINTS * low + high;
    while (at < cut->tie_count && pieces[at - first] < name)
        at++;
    if (at < cut->tie_count && pieces[at - first] == name)
        return cut->ties + at;
    for (int k = cut->tie_count++; k > at; k--) {
        cut->ties[k] = cut->ties[k - 1];
        pieces[k - first] = pieces[k - first - 1];
    }
    pieces[at - first] = name;
    memset(cut->ties + at, 0, sizeof *cut->ties);
    cut->ties[at].cells[0] = sbi_cut_next_cell(cut, tet, low);
    cut->ties[at].cells[1] = sbi_cut_next_cell(cut, tet, high);
    return cut->ties + at;
}

static void sbi_cut_add_facet(int nodes, sbi_glue_tie *tie, const sbi_cut_facet *facet)
{
    for (int a = 0; a < nodes; a++)
        for (int b = a; b < nodes; b++)
            tie->gram[sbi_glue_at(nodes, a, b)] += facet->firmness * facet->shape[a] * facet->shape[b];
}

/* Ties of the triangles of one tet, next_glue[first .. end). */
static void sbi_cut_tie_tet(sb_cut *cut, int first, int end)
{
    int tet = cut->next_glue[first].tet, begin = cut->tie_count, pieces[SBI_LATTICE_MICROS * (int)SBI_LIPS];
    sbi_parted parted;
    sbi_parted_make(&cut->lattice, &cut->links, cut->tets + 4 * (size_t)tet, tet, &parted);
    for (int i = first; i < end; i++) {
        sbi_lip lips[SBI_LIPS];
        int count = sbi_parted_lips(&parted, cut->next_glue[i].place / SBI_LIPS, lips);
        for (int k = 0; k < count; k++) {
            sbi_cut_facet facet;
            if (lips[k].place != cut->next_glue[i].place % SBI_LIPS)
                continue;
            facet = sbi_cut_facet_make(cut, tet, &parted, lips + k);
            sbi_cut_add_facet(cut->nodes_per_tet, sbi_cut_find_tie(cut, tet, lips + k, begin, pieces), &facet);
        }
    }
}

SBI_API int sbi_cut_make_ties(sb_cut *cut)
{
    cut->tie_count = 0;
    for (int first = 0, end; first < cut->next_glue_count; first = end) {
        for (end = first + 1; end < cut->next_glue_count && cut->next_glue[end].tet == cut->next_glue[first].tet;)
            end++;
        if (!sbi_cut_reserve_ties(cut, end - first))
            return 0;
        sbi_cut_tie_tet(cut, first, end);
    }
    return 1;
}

SBI_API void sbi_cut_take_next_glue(sb_cut *cut)
{
    sbi_cut_glued *glue = cut->glue;
    int capacity = cut->glue_capacity;
    cut->glue = cut->next_glue;
    cut->glue_count = cut->next_glue_count;
    cut->glue_capacity = cut->next_glue_capacity;
    cut->next_glue = glue;
    cut->next_glue_capacity = capacity;
    cut->next_glue_count = 0;
}
