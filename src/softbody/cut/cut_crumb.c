/* cut_crumb: parts that a cut leaves and that are too small to keep.
 *
 * From each piece that a call has made, or that it has released from its glue, its part is searched, over nodes that
 * cells will share and over glue, until it is larger than a crumb or has a support: a few pieces as a rule. What an
 * earlier search of the call has met is no crumb's: those are searched to their ends. */
#include "cut_private.h"

#include <string.h>

#include "../body/rigid_private.h"

/* A piece as it is to be: a record, or ~ a piece of a tet that has no records. */
typedef int sbi_cut_handle;

enum { SBI_CUT_CRUMBLES = -1 }; /* in place of the search that has found a piece */

static int *sbi_cut_crumb_mark(sb_cut *cut, sbi_cut_handle at)
{
    return at >= 0 ? &cut->cells[at].crumb : &cut->pieces[~at].crumb;
}

/* Element of a handle. */
static int sbi_cut_handle_tet(const sb_cut *cut, sbi_cut_handle at)
{
    return at >= 0 ? cut->cells[at].tet : cut->elements.items[cut->pieces[~at].cell];
}

/* A node of a piece before the call. */
static int sbi_cut_handle_node(const sb_cut *cut, sbi_cut_handle at, int local)
{
    return at >= 0 ? cut->cells[at].old_nodes[local] : sbi_cut_piece_nodes(cut, ~at)[local];
}

/* ---- one search ---- */

typedef struct sbi_cut_flood {
    int number; /* of the search */
    int first;  /* of its pieces in cut->flooded */
    int ends;   /* 1: it is no crumb */
    int failed; /* 1: no memory */
    int found;  /* 1: a search has found a crumb, or a film without volume */
    double volume;
} sbi_cut_flood;

static void sbi_cut_visit(sb_cut *cut, sbi_cut_flood *flood, sbi_cut_handle at)
{
    int *mark = sbi_cut_crumb_mark(cut, at);
    flood->ends |= *mark != 0 && *mark != flood->number;
    if (*mark != 0)
        return;
    if (!sbi_cut_list_grow(cut, &cut->flooded, 1)) {
        flood->failed = 1;
        return;
    }
    *mark = flood->number;
    cut->flooded.items[cut->flooded.count++] = at;
}

/* Visits the pieces around a node of the uncut mesh that will share corner a of a piece. */
static void sbi_cut_visit_around(sb_cut *cut, sbi_cut_flood *flood, sbi_cut_handle at, int a)
{
    int node = cut->tets[4 * (size_t)sbi_cut_handle_tet(cut, at) + (size_t)a], is_new = cut->node_marks[node];
    int mine = is_new ? sbi_cut_root(cut, cut->nodes_per_tet * at + a) : sbi_cut_handle_node(cut, at, a);
    for (int k = cut->node_tets.offsets[node]; k < cut->node_tets.offsets[node + 1]; k++) {
        int tet = cut->node_tets.items[k], first = cut->cell_of[tet] - 1, corner = 0;
        while (cut->tets[4 * (size_t)tet + (size_t)corner] != node)
            corner++;
        for (int i = first, end = first < 0 ? first : sbi_cut_end_of(cut, first); i < end; i++)
            if (!cut->cells[i].is_gone &&
                (is_new ? sbi_cut_root(cut, cut->nodes_per_tet * i + corner) : cut->cells[i].old_nodes[corner]) == mine)
                sbi_cut_visit(cut, flood, i);
        for (int piece = first < 0 ? sbi_cut_first_piece(cut, tet) : -1; piece >= 0; piece = cut->pieces[piece].next)
            if (sbi_cut_handle_node(cut, ~piece, corner) == mine)
                sbi_cut_visit(cut, flood, ~piece);
    }
}

/* Visits the pieces of a tet that have any of these points of its lattice. */
static void sbi_cut_visit_points(sb_cut *cut, sbi_cut_flood *flood, int tet, uint64_t points)
{
    int first = cut->cell_of[tet] - 1;
    for (int i = first, end = first < 0 ? first : sbi_cut_end_of(cut, first); i < end; i++)
        if (!cut->cells[i].is_gone && (cut->cells[i].points & points))
            sbi_cut_visit(cut, flood, i);
    for (int piece = first < 0 ? sbi_cut_first_piece(cut, tet) : -1; piece >= 0; piece = cut->pieces[piece].next)
        if (cut->pieces[piece].points & points)
            sbi_cut_visit(cut, flood, ~piece);
}

/* First triangle of a tet, or of one behind it, that is to be glued. */
static int sbi_cut_first_glued(const sb_cut *cut, int tet)
{
    int low = 0, high = cut->next_glue_count;
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (cut->next_glue[middle].tet < tet)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

/* The points of the lattice that a glued triangle lies between: one on either side. */
static const unsigned char *sbi_cut_glued_sides(const sb_cut *cut, const sbi_cut_glued *glued)
{
    const unsigned char *links = cut->lattice.micro_links[glued->place / SBI_LIPS];
    return cut->lattice.links[links[glued->place % SBI_LIPS / 2]];
}

/* Visits the pieces that glue will tie to this one: other pieces of a glued tet may be loose. */
static void sbi_cut_visit_tied(sb_cut *cut, sbi_cut_flood *flood, sbi_cut_handle at)
{
    int tet = sbi_cut_handle_tet(cut, at);
    uint64_t own = at >= 0 ? cut->cells[at].points : cut->pieces[~at].points, others = 0;
    for (int k = sbi_cut_first_glued(cut, tet); k < cut->next_glue_count && cut->next_glue[k].tet == tet; k++) {
        const unsigned char *sides = sbi_cut_glued_sides(cut, cut->next_glue + k);
        for (int side = 0; side < 2; side++)
            others |= own >> sides[side] & 1 ? (uint64_t)1 << sides[1 - side] : 0;
    }
    if (others & ~own)
        sbi_cut_visit_points(cut, flood, tet, others & ~own);
}

/* 1 when a node of a piece is to be supported. */
static int sbi_cut_is_held(const sb_cut *cut, sbi_cut_handle at, int local)
{
    if (!sbi_body_held_axes(cut->body, sbi_cut_handle_node(cut, at, local)))
        return 0;
    return !cut->node_marks[sbi_cut_tet_nodes(cut, sbi_cut_handle_tet(cut, at))[local]] ||
           sbi_cut_has_material(cut, cut->cells + at, local) || sbi_cut_held_axes(cut, cut->cells + at, local);
}

/* Searches the part of a piece; 1: it is a crumb. */
static int sbi_cut_flood_from(sb_cut *cut, sbi_cut_flood *flood, sbi_cut_handle seed)
{
    int is_held = 0;
    flood->number++;
    flood->first = cut->flooded.count;
    flood->ends = 0;
    flood->volume = 0;
    sbi_cut_visit(cut, flood, seed);
    for (int k = flood->first; k < cut->flooded.count && !flood->ends && !flood->failed; k++) {
        sbi_cut_handle at = cut->flooded.items[k];
        int tet = sbi_cut_handle_tet(cut, at);
        sb_real share = at >= 0 ? cut->cells[at].share : sb_body_cell_share(cut->body, cut->pieces[~at].cell);
        flood->volume += (double)share * (double)sbi_cut_tet_volume(cut, tet);
        flood->ends |= flood->volume >= (double)cut->least_volume;
        for (int a = 0; a < cut->nodes_per_tet && !flood->ends && !is_held; a++)
            is_held = sbi_cut_is_held(cut, at, a);
        flood->ends |= is_held && flood->volume > 0; /* a film without volume is no part, even where it is held */
        for (int a = 0; a < 4 && !flood->ends; a++)  /* where pieces share a middle they share both ends */
            sbi_cut_visit_around(cut, flood, at, a);
        if (!flood->ends)
            sbi_cut_visit_tied(cut, flood, at);
    }
    return !flood->ends && !flood->failed;
}

/* ---- all of them ---- */

/* Searches from one piece, and marks those of a crumb. */
static void sbi_cut_try_crumb(sb_cut *cut, sbi_cut_flood *flood, sbi_cut_handle seed)
{
    if (*sbi_cut_crumb_mark(cut, seed) != 0 || flood->failed || !sbi_cut_flood_from(cut, flood, seed))
        return;
    cut->removed.crumbs += flood->volume > 0;
    flood->found = 1;
    for (int k = flood->first; k < cut->flooded.count; k++)
        *sbi_cut_crumb_mark(cut, cut->flooded.items[k]) = SBI_CUT_CRUMBLES;
}

/* From records of what has parted, and from what was glued before the call. */
static void sbi_cut_try_all(sb_cut *cut, sbi_cut_flood *flood)
{
    for (int i = 0; i < cut->cell_count; i++)
        if (cut->cells[i].is_cut && !cut->cells[i].is_gone)
            sbi_cut_try_crumb(cut, flood, i);
    for (int k = 0; k < cut->glue_count && cut->next_glue_count != cut->glue_count; k++) {
        int tet = cut->glue[k].tet, first = cut->cell_of[tet] - 1;
        if (k > 0 && cut->glue[k - 1].tet == tet)
            continue;
        for (int i = first, end = first < 0 ? first : sbi_cut_end_of(cut, first); i < end; i++)
            if (!cut->cells[i].is_gone)
                sbi_cut_try_crumb(cut, flood, i);
        for (int piece = first < 0 ? sbi_cut_first_piece(cut, tet) : -1; piece >= 0; piece = cut->pieces[piece].next)
            sbi_cut_try_crumb(cut, flood, ~piece);
    }
}

/* 1 when what a triangle is to glue is gone: both sides are of one part. */
static int sbi_cut_crumbles(const sb_cut *cut, const sbi_cut_glued *glued)
{
    const int first = cut->cell_of[glued->tet] - 1, side = sbi_cut_glued_sides(cut, glued)[0];
    for (int i = first, end = first < 0 ? first : sbi_cut_end_of(cut, first); i < end; i++)
        if (cut->cells[i].points >> side & 1)
            return cut->cells[i].is_gone;
    return 0;
}

/* Records of the pieces of crumbs are gone, and so is the glue within; 0: no memory. */
static int sbi_cut_lose_crumbs(sb_cut *cut)
{
    int kept = 0;
    for (int k = 0; k < cut->flooded.count; k++) {
        sbi_cut_handle at = cut->flooded.items[k];
        int tet = sbi_cut_handle_tet(cut, at), first = cut->cell_of[tet] - 1;
        if (*sbi_cut_crumb_mark(cut, at) != SBI_CUT_CRUMBLES)
            continue;
        if (at < 0 && first < 0 && !sbi_cut_add_tet(cut, tet))
            return 0;
        if (at >= 0)
            cut->cells[at].is_gone = 1;
        first = cut->cell_of[tet] - 1;
        for (int i = first, end = at >= 0 ? first : sbi_cut_end_of(cut, first); i < end; i++)
            cut->cells[i].is_gone |= cut->cells[i].piece == ~at;
    }
    for (int k = 0; k < cut->next_glue_count; k++)
        if (!sbi_cut_crumbles(cut, cut->next_glue + k))
            cut->next_glue[kept++] = cut->next_glue[k];
    cut->next_glue_count = kept;
    return 1;
}

SBI_API int sbi_cut_find_crumbs(sb_cut *cut)
{
    sbi_cut_flood flood;
    int done;
    memset(&flood, 0, sizeof flood);
    cut->flooded.count = 0;
    sbi_cut_try_all(cut, &flood);
    done = !flood.failed && (!flood.found || sbi_cut_lose_crumbs(cut));
    for (int k = 0; k < cut->flooded.count; k++)
        *sbi_cut_crumb_mark(cut, cut->flooded.items[k]) = 0;
    return done;
}
