/* cut_predict: how cuts go on where blades have come into elements but not through them.
 *
 * An element that is not cut through is parted along the plane of the triangle that struck it last, by links that are
 * predicted; glue (cut_glue.c) holds together what no blade has passed yet. Predictions stay: a blade that turns away
 * cuts other links, and one that comes along the same way crosses them. */
#include "cut_private.h"

enum { SBI_CUT_ROUNDS = 4 }; /* of looking for elements that predictions of others have struck at their corners */

/* The last blade that has struck a link of a tet between two of these points; -1: none. */
static int sbi_cut_last_struck(const sb_cut *cut, const sbi_parted *parted, uint64_t points)
{
    int last = -1;
    for (int l = 0; l < cut->lattice.link_count; l++) {
        const unsigned char *ends = cut->lattice.links[l];
        if (parted->rank[l] >= 0 && (points >> ends[0] & points >> ends[1] & 1))
            last = sbi_max_int(last, cut->links.items[parted->rank[l]].struck);
    }
    return last;
}

static uint64_t sbi_cut_points_above(const sb_cut *cut, const sbi_cut_shape *shape, const sbi_blade *blade)
{
    uint64_t above = 0;
    for (int p = 0; p < cut->lattice.point_count; p++)
        if (sbi_blade_side(blade, sbi_blade_height(blade, shape->places[p])) > 0)
            above |= (uint64_t)1 << p;
    return above;
}

/* Predicts the links that a tet has otherwise in `trial`, where a blade's plane crosses them; 0: no memory. */
static int sbi_cut_add_predicted(sb_cut *cut, const sbi_parted *trial, const sbi_cut_shape *shape, int tet, int blade)
{
    for (int l = 0; l < cut->lattice.link_count; l++) {
        sbi_link_key key;
        int ends[2];
        double from, to;
        if (trial->cut[l] != SBI_LINK_PREDICTED || trial->rank[l] >= 0)
            continue;
        key = sbi_lattice_key(&cut->lattice, &shape->order, tet, l);
        sbi_lattice_ends(&cut->lattice, &shape->order, l, ends);
        from = sbi_blade_height(cut->blades + blade, shape->places[ends[0]]);
        to = sbi_blade_height(cut->blades + blade, shape->places[ends[1]]);
        if (!sbi_cut_add_link(cut, &key, (sb_real)(from / (from - to)), SBI_LINK_PREDICTED, blade))
            return 0;
    }
    return 1;
}

/* Parts some points of a tet, which are of one piece, along the plane of the last triangle that struck it, if that
 * parts them; *parted is what it is then. 0: no memory. */
static int sbi_cut_predict_points(sb_cut *cut, const sbi_crossing_frame *frame, int part, int tet, uint64_t points,
                                  sbi_parted *parted)
{
    sbi_parted trial = *parted;
    sbi_cut_shape shape;
    uint64_t above;
    int first = 0, piece, blade;
    while (!(points >> first & 1))
        first++;
    piece = sbi_cut_piece_with(cut, tet, first);
    blade = sbi_cut_last_struck(cut, parted, cut->pieces[piece].points);
    if (blade < 0 || !sbi_cut_is_of(cut, sbi_cut_piece_nodes(cut, piece)[0], part))
        return 1;
    sbi_cut_shape_make(cut, tet, piece, frame, &shape);
    above = sbi_cut_points_above(cut, &shape, cut->blades + blade);
    for (int l = 0; l < cut->lattice.link_count; l++) {
        const unsigned char *ends = cut->lattice.links[l];
        if (!trial.cut[l] && (points >> ends[0] & points >> ends[1] & 1) &&
            (above >> ends[0] & 1) != (above >> ends[1] & 1))
            trial.cut[l] = SBI_LINK_PREDICTED;
    }
    sbi_parted_find(&trial);
    if (trial.piece_count <= parted->piece_count)
        return 1;
    if (!sbi_cut_add_predicted(cut, &trial, &shape, tet, blade))
        return 0;
    sbi_parted_make(&cut->lattice, &cut->links, cut->tets + 4 * (size_t)tet, tet, parted);
    return 1;
}

/* 1 when a cut link has both ends among these points. */
static int sbi_cut_is_open(const sb_cut *cut, const sbi_parted *parted, uint64_t points)
{
    int is_open = 0;
    for (int l = 0; l < cut->lattice.link_count && !is_open; l++) {
        const unsigned char *ends = cut->lattice.links[l];
        is_open = parted->cut[l] && (points >> ends[0] & points >> ends[1] & 1);
    }
    return is_open;
}

/* The pieces of a tet that blades have come into but not through. */
static int sbi_cut_predict_tet(sb_cut *cut, const sbi_crossing_frame *frame, int part, int tet)
{
    sbi_parted parted;
    uint64_t pieces[SBI_LATTICE_POINTS];
    int count, done = 1;
    sbi_parted_make(&cut->lattice, &cut->links, cut->tets + 4 * (size_t)tet, tet, &parted);
    count = parted.piece_count;
    for (int k = 0; k < count; k++)
        pieces[k] = parted.pieces[k];
    for (int k = 0; k < count && done; k++)
        if (sbi_cut_is_open(cut, &parted, pieces[k]))
            done = sbi_cut_predict_points(cut, frame, part, tet, pieces[k], &parted);
    return done;
}

/* 1 when the corners of a tet do not hang together by its edges, those with a cut link counting for nothing. */
static int sbi_cut_corners_part(const sb_cut *cut, const sbi_parted *parted)
{
    int holds[16], reached = 1, before = 0;
    for (int k = 0; k < 16; k++)
        holds[k] = 1;
    for (int l = 0; l < cut->lattice.link_count; l++)
        if (parted->cut[l])
            holds[sbi_lattice_link_corners(&cut->lattice, l)] = 0;
    while (reached != before) {
        before = reached;
        for (int a = 0; a < 4; a++)
            for (int b = 0; b < 4; b++)
                if (a != b && (reached >> a & 1) && holds[1 << a | 1 << b])
                    reached |= 1 << b;
    }
    return reached != 15;
}

/* The corner rule: a tet whose corners have come apart along its edges while they are of one piece within. */
static int sbi_cut_predict_corners(sb_cut *cut, const sbi_crossing_frame *frame, int part, int tet)
{
    sbi_parted parted;
    sbi_parted_make(&cut->lattice, &cut->links, cut->tets + 4 * (size_t)tet, tet, &parted);
    if (parted.piece_of[0] == SBI_PARTED_LOST || parted.piece_of[0] != parted.piece_of[1] ||
        parted.piece_of[0] != parted.piece_of[2] || parted.piece_of[0] != parted.piece_of[3] ||
        !sbi_cut_corners_part(cut, &parted))
        return 1;
    return sbi_cut_predict_points(cut, frame, part, tet, parted.pieces[parted.piece_of[0]], &parted);
}

SBI_API int sbi_cut_predict(sb_cut *cut, const sbi_crossing_frame *frame, int part)
{
    int touched = cut->touched.count, done = 1, links = -1;
    for (int i = 0; i < touched && done; i++)
        done = sbi_cut_predict_tet(cut, frame, part, cut->touched.items[i]);
    for (int round = 0; round < SBI_CUT_ROUNDS && cut->lattice.intervals > 1 && links != cut->links.count; round++) {
        links = cut->links.count;
        touched = cut->touched.count;
        for (int i = 0; i < touched && done; i++)
            done = sbi_cut_predict_corners(cut, frame, part, cut->touched.items[i]);
    }
    return done;
}
