/* topology: which cells and copies of nodes a cut makes.
 *
 * Every piece of a tet is a cell with all of its nodes. Those of pieces that touch over a face with that node are one:
 * classes of a union-find over the pieces around the node. Nodes in the middle of edges have classes of their own: they
 * may have copies where the ends of the edge hang together around a front. The class with the material at the node's
 * place keeps its number, of a copy's classes the first; the others get copies. Contact over an edge or in a point does
 * not hold.
 * All loops are in ascending order of nodes, tets and lattice points: so are new numbers. */
#include "cut_private.h"

#include <string.h>

#include "../body/rigid_private.h"

/* ---- copies ---- */

/* The class of a node among those listed, or the next one. */
static int sbi_cut_class_of(const sb_cut *cut, int root)
{
    int at = 0;
    while (at < cut->class_count && cut->classes[at].root != root)
        at++;
    return at;
}

/* Lists the classes around a node, in the order of their first records; 0: no memory. */
static int sbi_cut_list_classes(sb_cut *cut, int node)
{
    cut->class_count = 0;
    for (int k = cut->node_tets.offsets[node]; k < cut->node_tets.offsets[node + 1]; k++) {
        int first = cut->cell_of[cut->node_tets.items[k]] - 1, end = first < 0 ? -1 : sbi_cut_end_of(cut, first);
        for (int i = first; i < end; i++) {
            const sbi_cut_cell *cell = cut->cells + i;
            int local = sbi_cut_local_of(cut, cell, node), root = sbi_cut_root(cut, cut->nodes_per_tet * i + local);
            int at = sbi_cut_class_of(cut, root), grown;
            void *classes = cut->classes;
            if (cell->is_gone)
                continue;
            grown = sbi_cut_grow(&cut->allocator, &classes, &cut->class_capacity, cut->class_count, 1,
                                 sizeof *cut->classes);
            cut->classes = (sbi_cut_class *)classes;
            if (!grown)
                return 0;
            if (at == cut->class_count) {
                cut->classes[at].root = root;
                cut->classes[at].old = cell->old_nodes[local];
                cut->classes[at].has = cut->classes[at].held = 0;
                cut->class_count++;
            }
            cut->classes[at].has |= sbi_cut_has_material(cut, cell, local);
            cut->classes[at].held |= sbi_cut_held_axes(cut, cell, local);
        }
    }
    return 1;
}

/* The class that keeps an old number: that with the material at the node's place, or, of a copy, the first that has all
 * of its supports; else the first. */
static int sbi_cut_keeper(const sb_cut *cut, int node, int old)
{
    int first = -1;
    for (int k = 0; k < cut->class_count; k++) {
        if (cut->classes[k].old != old)
            continue;
        if (first < 0)
            first = k;
        if (old == node ? cut->classes[k].has : (sbi_body_held_axes(cut->body, old) & ~cut->classes[k].held) == 0)
            return k;
    }
    return first;
}

/* A copy for a class around `node`. */
static sb_result sbi_cut_add_copy(sb_cut *cut, sb_body_change *change, int node, sbi_cut_class *of, sb_error *error)
{
    static const sb_real one = 1;
    sb_result result;
    result = sb_body_change_add_node(change, sb_body_rest_positions(cut->body)[of->old], &of->old, &one, 1,
                                     SB_NODE_COPY | of->held * SB_NODE_KEEP_X, &of->number, error);
    if (result != SB_OK)
        return result;
    if (!sbi_cut_list_grow(cut, &cut->origins, sbi_max_int(of->number + 1 - cut->origins.count, 0)))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a copy of node %d", node);
    sbi_cut_list_set(&cut->origins, of->number, node);
    cut->made_nodes++;
    return SB_OK;
}

/* Numbers of a node in the records around it. */
static sb_result sbi_cut_number_node(sb_cut *cut, sb_body_change *change, int node, sb_error *error)
{
    if (!sbi_cut_list_classes(cut, node))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the pieces around node %d", node);
    for (int k = 0; k < cut->class_count; k++) {
        sbi_cut_class *class_k = cut->classes + k;
        sb_result result = SB_OK;
        class_k->number = class_k->old;
        if (sbi_cut_keeper(cut, node, class_k->old) != k)
            result = sbi_cut_add_copy(cut, change, node, class_k, error);
        if (result != SB_OK)
            return result;
    }
    for (int k = cut->node_tets.offsets[node]; k < cut->node_tets.offsets[node + 1]; k++) {
        int first = cut->cell_of[cut->node_tets.items[k]] - 1, end = first < 0 ? -1 : sbi_cut_end_of(cut, first);
        for (int i = first; i < end; i++) {
            int local = sbi_cut_local_of(cut, cut->cells + i, node);
            int root = sbi_cut_root(cut, cut->nodes_per_tet * i + local);
            if (!cut->cells[i].is_gone)
                cut->cells[i].nodes[local] = cut->classes[sbi_cut_class_of(cut, root)].number;
        }
    }
    return SB_OK;
}

static sb_result sbi_cut_number_nodes(sb_cut *cut, sb_body_change *change, sb_error *error)
{
    sb_result result = SB_OK;
    for (int node = 0; node < cut->node_end && result == SB_OK; node++)
        if (cut->node_marks[node])
            result = sbi_cut_number_node(cut, change, node, error);
    return result;
}

/* ---- cells ---- */

/* What the pieces of a tet are. */
typedef struct sbi_cut_measures {
    sbi_part_moments moments[SBI_LATTICE_POINTS];
    sb_real faces[SBI_LATTICE_POINTS][24]; /* face_loads of sb_change_cell */
} sbi_cut_measures;

/* What the nodes of a face have of a piece's part of it: of tet4 means of L_a, of tet10 of 4 L_a L_b between corners
 * and L_a (2 L_a - 1) = L_a - 2 L_a (L_b + L_c) at them. */
static void sbi_cut_face_loads(int face, int face_nodes, const sbi_face_moments *moments, sb_real *loads)
{
    int local[SB_MAX_FACE_NODES];
    sb_element_face(face_nodes == 3 ? SB_TET4 : SB_TET10, face, local, NULL);
    for (int k = 0; k < 3; k++)
        loads[k] = moments->loads[local[k]];
    for (int k = 3; k < face_nodes; k++) /* node 4 + e of a tet10 is in the middle of edge e */
        loads[k] = 4 * moments->products[local[k] - 4];
    for (int k = 0; k < 3 && face_nodes == 6; k++)
        loads[k] -= (loads[3 + k] + loads[3 + (k + 2) % 3]) / 2;
}

static void sbi_cut_measure(const sb_cut *cut, int tet, sbi_cut_measures *measures)
{
    const int face_nodes = sbi_piece_face_nodes(cut->nodes_per_tet);
    sbi_parted parted;
    sbi_face_moments of_face[SBI_LATTICE_POINTS];
    sbi_cut_parted(cut, tet, &parted);
    sbi_parted_moments(&parted, sbi_cut_least(cut), measures->moments);
    for (int face = 0; face < 4; face++) {
        sbi_parted_face(&parted, face, of_face);
        for (int k = 0; k < parted.piece_count; k++)
            sbi_cut_face_loads(face, face_nodes, of_face + k, measures->faces[k] + face * face_nodes);
    }
}

/* Makes or replaces the cell of a record, which is this piece of its tet; measures NULL: all of it. */
static sb_result sbi_cut_put_cell(sb_cut *cut, sb_body_change *change, int record, const sbi_cut_measures *measures,
                                  int piece, sb_error *error)
{
    sbi_cut_cell *cell = cut->cells + record;
    sb_change_cell made = sb_default_change_cell();
    sb_cell_moments of_piece;
    made.nodes = cell->nodes;
    made.parent = cell->cell;
    if (measures) {
        of_piece.centroid = measures->moments[piece].centre;
        of_piece.covariance = measures->moments[piece].spread;
        made.share = sb_min(measures->moments[piece].share, 1);
        made.moments = &of_piece;
        made.face_loads = measures->faces[piece];
    }
    cut->made_cells += cell->is_new;
    return cell->is_new ? sb_body_change_add_cell(change, &made, &cell->cell, error)
                        : sb_body_change_replace_cell(change, cell->cell, &made, error);
}

/* 1 when a record is to have another cell than there is. */
static int sbi_cut_differs(const sb_cut *cut, const sbi_cut_cell *cell)
{
    size_t nodes = (size_t)cut->nodes_per_tet * sizeof(int);
    return !cell->is_gone && (cell->is_cut || memcmp(cell->nodes, cell->old_nodes, nodes) != 0);
}

/* Of the records of one piece the first that stays keeps its cell. */
static void sbi_cut_claim_cells(sb_cut *cut, int first, int end)
{
    for (int i = first; i < end; i++) {
        sbi_cut_cell *cell = cut->cells + i;
        cell->is_new = 0;
        for (int k = first; k < i; k++)
            cell->is_new |= cut->cells[k].piece == cell->piece && !cut->cells[k].is_gone;
    }
}

/* The cells of one tet's records that are others now. */
static sb_result sbi_cut_put_tet(sb_cut *cut, sb_body_change *change, int first, int end, sb_error *error)
{
    sbi_cut_measures measures;
    sb_result result = SB_OK;
    int differs = 0, is_whole = cut->cells[first].points == sbi_lattice_all(&cut->lattice);
    sbi_cut_claim_cells(cut, first, end);
    for (int i = first; i < end; i++)
        differs |= sbi_cut_differs(cut, cut->cells + i);
    if (!differs)
        return SB_OK;
    if (!is_whole)
        sbi_cut_measure(cut, cut->cells[first].tet, &measures);
    for (int i = first; i < end && result == SB_OK; i++)
        if (sbi_cut_differs(cut, cut->cells + i))
            result = sbi_cut_put_cell(cut, change, i, is_whole ? NULL : &measures, i - first, error);
    return result;
}

static sb_result sbi_cut_put_cells(sb_cut *cut, sb_body_change *change, sb_error *error)
{
    sb_result result = SB_OK;
    for (int first = 0, end; first < cut->cell_count && result == SB_OK; first = end) {
        end = sbi_cut_end_of(cut, first);
        result = sbi_cut_put_tet(cut, change, first, end, error);
    }
    return result;
}

/* 1 when a record is the first of a piece none of which stays. */
static int sbi_cut_ends_piece(const sb_cut *cut, int record)
{
    int piece = cut->cells[record].piece, end = sbi_cut_end_of(cut, record), ends = cut->cells[record].is_gone;
    for (int i = cut->cell_of[cut->cells[record].tet] - 1; i < end && ends; i++)
        ends = cut->cells[i].piece != piece || (cut->cells[i].is_gone && i >= record);
    return ends;
}

/* Makes the cell of a record an empty piece: the last one of a body without material. */
static sb_result sbi_cut_empty_cell(const sb_cut *cut, sb_body_change *change, int record, sb_error *error)
{
    static const sb_real nothing[24] = {0};
    const sb_real middle = (sb_real)0.25;
    sb_change_cell made = sb_default_change_cell();
    sb_cell_moments moments;
    moments.centroid = sb_v3(middle, middle, middle);
    moments.covariance = sb_m3_zero();
    made.nodes = cut->cells[record].old_nodes;
    made.parent = cut->cells[record].cell;
    made.share = 0;
    made.moments = &moments;
    made.face_loads = nothing;
    return sb_body_change_replace_cell(change, made.parent, &made, error);
}

/* Removes the cells of pieces that are gone, but for the last cell of all. */
static sb_result sbi_cut_remove_cells(sb_cut *cut, sb_body_change *change, sb_error *error)
{
    const sbi_slots *cells = &cut->body->live->cells;
    int left = cells->fresh - cells->count + cut->made_cells;
    sb_result result = SB_OK;
    for (int i = 0; i < cut->cell_count && result == SB_OK; i++) {
        sbi_cut_cell *cell = cut->cells + i;
        int ends = sbi_cut_ends_piece(cut, i);
        if (ends && left == 1) {
            result = sbi_cut_empty_cell(cut, change, i, error);
            continue;
        }
        if (ends)
            result = sb_body_change_remove_cell(change, cell->cell, error);
        left -= ends;
        if (cell->is_gone)
            cell->cell = -1;
    }
    return result;
}

/* What is taken out, before the change with a factor 1, and with -1 after it. */
static void sbi_cut_weigh(sb_cut *cut, double factor)
{
    sbi_live_moment sum;
    double volume = 0;
    memset(&sum, 0, sizeof sum);
    for (int first = 0, end; first < cut->cell_count; first = end) {
        int tet = cut->cells[first].tet, loses = (cut->tet_marks[tet] & SBI_CUT_LOSES) != 0, piece;
        end = sbi_cut_end_of(cut, first);
        for (int i = first; i < end; i++)
            loses |= cut->cells[i].is_gone;
        for (piece = sbi_cut_first_piece(cut, tet); piece >= 0 && loses; piece = cut->pieces[piece].next) {
            int cell = cut->pieces[piece].cell;
            volume += (double)sb_body_cell_share(cut->body, cell) * (double)sbi_cut_tet_volume(cut, tet);
            sbi_live_add_cell(cut->body, cell, sb_v3(0, 0, 0), 1, &sum, NULL);
        }
    }
    cut->removed.volume += factor * volume;
    cut->removed.mass += factor * sum.mass;
    for (int k = 0; k < 3; k++)
        cut->removed.momentum[k] += factor * sum.linear[k];
}

/* ---- pieces ---- */

/* Room for the pieces that the records have more than there are; 0: no memory. */
static int sbi_cut_reserve_pieces(sb_cut *cut)
{
    int more = 0, cells = 0, grown;
    void *pieces = cut->pieces;
    for (int i = 0; i < cut->cell_count; i++) {
        more += cut->cells[i].is_new && !cut->cells[i].is_gone;
        cells = sbi_max_int(cells, cut->cells[i].cell + 1);
    }
    grown = sbi_cut_grow(&cut->allocator, &pieces, &cut->piece_capacity, cut->piece_count, more, sizeof *cut->pieces);
    cut->pieces = (sbi_cut_piece *)pieces;
    return grown && sbi_cut_list_grow(cut, &cut->elements, sbi_max_int(cells - cut->elements.count, 0));
}

/* A piece behind the last one of a tet, in a slot that there is room for. */
static int sbi_cut_append_piece(sb_cut *cut, int last)
{
    int piece = cut->free_piece >= 0 ? cut->free_piece : cut->piece_count++;
    if (piece == cut->free_piece)
        cut->free_piece = cut->pieces[piece].next;
    cut->pieces[last].next = piece;
    return piece;
}

/* Takes the pieces of a tet from its records. */
static void sbi_cut_keep_tet(sb_cut *cut, int first, int end)
{
    int tet = cut->cells[first].tet, last = -1;
    for (int piece = cut->pieces[tet].next, next; piece >= 0; piece = next) {
        next = cut->pieces[piece].next;
        cut->pieces[piece].next = cut->free_piece;
        cut->free_piece = piece;
    }
    cut->pieces[tet].cell = cut->pieces[tet].next = -1;
    for (int i = first; i < end; i++) {
        const sbi_cut_cell *cell = cut->cells + i;
        if (cell->is_gone)
            cut->links.lost[tet] |= cell->points;
        if (cell->cell < 0)
            continue;
        last = last < 0 ? tet : sbi_cut_append_piece(cut, last);
        cut->pieces[last].points = cell->is_gone ? 0 : cell->points;
        cut->pieces[last].cell = cell->cell;
        cut->pieces[last].next = -1;
        cut->pieces[last].crumb = 0;
    }
}

/* Cells and copies that are gone are of no element and no node. */
static void sbi_cut_forget_gone(sb_cut *cut)
{
    for (int i = 0; i < cut->cell_count; i++) {
        int cell = cut->pieces[cut->cells[i].piece].cell;
        if (cut->cells[i].cell < 0 && !sb_body_cell_in_use(cut->body, cell))
            cut->elements.items[cell] = -1;
        for (int a = 0; a < cut->nodes_per_tet && cut->cells[i].is_gone; a++) {
            int node = cut->cells[i].old_nodes[a];
            if (node >= cut->node_end && sbi_live_first_cell(cut->body, node) < 0)
                cut->origins.items[node] = -1;
        }
    }
}

static void sbi_cut_keep(sb_cut *cut)
{
    sbi_cut_forget_gone(cut);
    for (int first = 0, end; first < cut->cell_count; first = end) {
        end = sbi_cut_end_of(cut, first);
        sbi_cut_keep_tet(cut, first, end);
    }
    sbi_cut_weigh(cut, -1);
}

/* ---- all of it ---- */

/* 1 when something is taken out. */
static int sbi_cut_is_eaten(const sb_cut *cut)
{
    int eaten = 0;
    for (int i = 0; i < cut->cell_count && !eaten; i++)
        eaten = cut->cells[i].is_gone || (cut->tet_marks[cut->cells[i].tet] & SBI_CUT_LOSES);
    return eaten;
}

/* Makes the change, with records and classes found. */
static sb_result sbi_cut_change(sb_cut *cut, sb_error *error)
{
    sb_body_change *change = NULL;
    sb_result result = sb_body_change_begin(cut->body, &change, error);
    if (result == SB_OK)
        result = sbi_cut_number_nodes(cut, change, error);
    if (result == SB_OK)
        result = sbi_cut_put_cells(cut, change, error);
    if (result == SB_OK)
        result = sbi_cut_remove_cells(cut, change, error);
    if (result == SB_OK && (!sbi_cut_reserve_pieces(cut) || !sbi_cut_make_ties(cut)))
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the pieces of a cut");
    for (int i = 0; i < cut->cell_count && result == SB_OK; i++)
        if (cut->cells[i].cell >= 0)
            sbi_cut_list_set(&cut->elements, cut->cells[i].cell, cut->cells[i].tet);
    if (result == SB_OK) {
        sbi_change_set_glue(change, cut->ties, cut->tie_count);
        if (sbi_cut_is_eaten(cut))
            sbi_change_erode(change);
        cut->changing = cut->body->live->find_knows = 1;
        sbi_body_mute(cut->body); /* a recording has the call itself */
        result = sb_body_change_commit(change, error);
        sbi_body_unmute(cut->body);
        cut->changing = cut->body->live->find_knows = 0;
    }
    if (result != SB_OK)
        sb_body_change_cancel(change);
    return result;
}

SBI_API void sbi_cut_clear(sb_cut *cut)
{
    if (!cut->touched.count && !cut->cell_count)
        return;
    memset(cut->tet_marks, 0, (size_t)cut->tet_count);
    memset(cut->node_marks, 0, (size_t)cut->node_end);
    memset(cut->cell_of, 0, (size_t)cut->tet_count * sizeof(int));
    cut->touched.count = cut->listed.count = cut->cell_count = cut->loss_count = 0;
}

/* Where glue has been released between pieces that stay. */
static sb_result sbi_cut_release(sb_cut *cut, sb_error *error)
{
    if (cut->next_glue_count == cut->glue_count)
        return SB_OK;
    if (!sbi_cut_make_ties(cut))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the glue of a cut");
    if (cut->tie_count < cut->body->live->glue.count) /* some hold nothing any more: parts may come apart */
        return sbi_cut_change(cut, error);
    sbi_body_set_glue(cut->body, cut->ties, cut->tie_count);
    return SB_OK;
}

/* Records of all pieces about what has parted or been released; 0: no memory. */
static int sbi_cut_make_records(sb_cut *cut)
{
    if (cut->listed.count == 0 && cut->next_glue_count == cut->glue_count)
        return 1;
    if (cut->listed.count > 0) {
        if (!sbi_cut_add_tets(cut))
            return 0;
        sbi_cut_join_all(cut);
    }
    return !(cut->least_volume > 0) || sbi_cut_find_crumbs(cut);
}

SBI_API sb_result sbi_cut_part(sb_cut *cut, sb_error *error)
{
    sb_result result = SB_OK;
    cut->cell_count = cut->made_nodes = cut->made_cells = 0;
    memset(&cut->removed, 0, sizeof cut->removed);
    if (!sbi_cut_make_records(cut))
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the pieces of a cut");
    else if (cut->cell_count == 0)
        result = sbi_cut_release(cut, error);
    else {
        sbi_cut_weigh(cut, 1);
        result = sbi_cut_change(cut, error);
        if (result == SB_OK)
            sbi_cut_keep(cut);
    }
    if (result == SB_OK)
        sbi_cut_take_next_glue(cut);
    else
        sbi_cut_take_back_lost(cut);
    sbi_cut_clear(cut);
    return result;
}
