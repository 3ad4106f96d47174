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

/* ---- tets that have parted ---- */

static void sbi_cut_parted(const sb_cut *cut, int tet, sbi_parted *parted)
{
    sbi_parted_make(&cut->lattice, &cut->links, cut->tets + 4 * (size_t)tet, tet, parted);
}

static int sbi_cut_chain_length(const sb_cut *cut, int tet)
{
    int count = 0;
    for (int piece = tet; piece >= 0; piece = cut->pieces[piece].next)
        count++;
    return count;
}

SBI_API void sbi_cut_find_parted(sb_cut *cut)
{
    sbi_parted parted;
    for (int i = 0; i < cut->touched.count; i++) {
        int tet = cut->touched.items[i];
        sbi_cut_parted(cut, tet, &parted);
        if (parted.piece_count == sbi_cut_chain_length(cut, tet))
            continue;
        cut->tet_marks[tet] |= SBI_CUT_PARTED;
        cut->parted.items[cut->parted.count++] = tet;
        for (int a = 0; a < cut->nodes_per_tet; a++)
            cut->node_marks[sbi_cut_tet_nodes(cut, tet)[a]] = 1;
    }
    for (int i = 0; i < cut->parted.count; i++)
        for (int a = 0; a < 4; a++) {
            int node = cut->tets[4 * (size_t)cut->parted.items[i] + (size_t)a];
            for (int k = cut->node_tets.offsets[node]; k < cut->node_tets.offsets[node + 1]; k++)
                cut->tet_marks[cut->node_tets.items[k]] |= SBI_CUT_NEAR;
        }
}

/* ---- records of the pieces around ---- */

static void sbi_cut_add_cell(sb_cut *cut, int tet, uint64_t points, int piece, const sbi_corner_order *order)
{
    sbi_cut_cell *cell = cut->cells + cut->cell_count;
    const int *nodes = sbi_cut_piece_nodes(cut, piece);
    cell->points = points;
    cell->tet = tet;
    cell->piece = piece;
    cell->is_cut = (cut->tet_marks[tet] & SBI_CUT_PARTED) != 0;
    cell->cell = cut->pieces[piece].cell;
    cell->is_new = 0;
    for (int k = cut->cell_of[tet] - 1; k < cut->cell_count; k++)
        cell->is_new |= cut->cells[k].piece == piece;
    for (int a = 0; a < cut->nodes_per_tet; a++)
        cell->old_nodes[a] = cell->nodes[a] = nodes[a];
    for (int face = 0; face < 4; face++)
        cell->marks[face] = (unsigned short)sbi_lattice_face_marks(&cut->lattice, order, face, points);
    cut->cell_count++;
}

/* Records of the pieces of a tet as they are to be; 0: no memory. */
static int sbi_cut_add_tet(sb_cut *cut, int tet)
{
    sbi_corner_order order = sbi_corner_order_make(cut->tets + 4 * (size_t)tet);
    void *cells = cut->cells;
    sbi_parted parted;
    int grown = sbi_cut_grow(&cut->allocator, &cells, &cut->cell_capacity, cut->cell_count, SBI_LATTICE_POINTS,
                             sizeof *cut->cells);
    cut->cells = (sbi_cut_cell *)cells;
    if (!grown)
        return 0;
    cut->cell_of[tet] = cut->cell_count + 1;
    if (!(cut->tet_marks[tet] & SBI_CUT_PARTED)) {
        for (int piece = tet; piece >= 0; piece = cut->pieces[piece].next)
            sbi_cut_add_cell(cut, tet, cut->pieces[piece].points, piece, &order);
        return 1;
    }
    sbi_cut_parted(cut, tet, &parted);
    for (int k = 0; k < parted.piece_count; k++) {
        int piece = tet;
        while (!(cut->pieces[piece].points & parted.pieces[k]))
            piece = cut->pieces[piece].next;
        sbi_cut_add_cell(cut, tet, parted.pieces[k], piece, &order);
    }
    return 1;
}

static int sbi_cut_add_tets(sb_cut *cut)
{
    for (int tet = 0; tet < cut->tet_count; tet++)
        if ((cut->tet_marks[tet] & SBI_CUT_NEAR) && !sbi_cut_add_tet(cut, tet))
            return 0;
    return sbi_cut_list_grow(cut, &cut->roots, cut->nodes_per_tet * cut->cell_count - cut->roots.count);
}

/* Records of a tet end here. */
static int sbi_cut_end_of(const sb_cut *cut, int first)
{
    int end = first;
    while (end < cut->cell_count && cut->cells[end].tet == cut->cells[first].tet)
        end++;
    return end;
}

/* ---- classes ---- */

static int sbi_cut_root(const sb_cut *cut, int i)
{
    int *parent = cut->roots.items;
    while (parent[i] != i)
        i = parent[i] = parent[parent[i]];
    return i;
}

static void sbi_cut_join(const sb_cut *cut, int i, int j)
{
    int a = sbi_cut_root(cut, i), b = sbi_cut_root(cut, j);
    cut->roots.items[sbi_max_int(a, b)] = sbi_min_int(a, b);
}

/* Joins the nodes of two records that touch over a face of the first. */
static void sbi_cut_join_over(const sb_cut *cut, int mine, int its, int face)
{
    const int *nodes = sbi_cut_tet_nodes(cut, cut->cells[mine].tet);
    const int *others = sbi_cut_tet_nodes(cut, cut->cells[its].tet);
    int local[SB_MAX_FACE_NODES], n = cut->nodes_per_tet;
    int count = sb_element_face(cut->body->domain.element_type, face, local, NULL);
    for (int k = 0; k < count; k++)
        for (int a = 0; a < n; a++)
            if (others[a] == nodes[local[k]] && cut->node_marks[others[a]])
                sbi_cut_join(cut, n * mine + local[k], n * its + a);
}

/* Joins nodes over all faces between tets with records. */
static void sbi_cut_join_all(sb_cut *cut)
{
    for (int i = 0; i < cut->nodes_per_tet * cut->cell_count; i++)
        cut->roots.items[i] = i;
    for (int mine = 0; mine < cut->cell_count; mine++) {
        int tet = cut->cells[mine].tet;
        for (int face = 0; face < 4; face++) {
            int other = cut->neighbours.items[4 * (size_t)tet + (size_t)face], there = 0, end;
            if (other < tet || !cut->cell_of[other])
                continue;
            while (cut->neighbours.items[4 * (size_t)other + (size_t)there] != tet)
                there++;
            end = sbi_cut_end_of(cut, cut->cell_of[other] - 1);
            for (int its = cut->cell_of[other] - 1; its < end; its++)
                if (cut->cells[mine].marks[face] & cut->cells[its].marks[there])
                    sbi_cut_join_over(cut, mine, its, face);
        }
    }
}

/* ---- copies ---- */

/* Axes along which all nodes of a boundary face of a record are held: those that a copy at it is held along. */
static int sbi_cut_held_axes(const sb_cut *cut, const sbi_cut_cell *cell, int node)
{
    int held = 0;
    for (int face = 0; face < 4; face++) {
        int local[SB_MAX_FACE_NODES], all = SB_XYZ, on = 0;
        int count = sb_element_face(cut->body->domain.element_type, face, local, NULL);
        for (int k = 0; k < count; k++) {
            on |= local[k] == node;
            all &= cut->body->fixed[cell->old_nodes[local[k]]];
        }
        if (on && cell->marks[face] && cut->neighbours.items[4 * (size_t)cell->tet + (size_t)face] < 0)
            held |= all;
    }
    return held;
}

/* Place among the nodes of a record of this node; -1: none. */
static int sbi_cut_local_of(const sb_cut *cut, const sbi_cut_cell *cell, int node)
{
    const int *nodes = sbi_cut_tet_nodes(cut, cell->tet);
    for (int a = 0; a < cut->nodes_per_tet; a++)
        if (nodes[a] == node)
            return a;
    return -1;
}

/* 1 when a record has the material in the middle of an edge of its tet, whose link is all of the edge. */
static int sbi_cut_has_middle(const sb_cut *cut, const sbi_cut_cell *cell, int edge)
{
    sbi_corner_order order = sbi_corner_order_make(cut->tets + 4 * (size_t)cell->tet);
    int link = cut->lattice.micro_links[0][edge], ends[2], item;
    sbi_link_key key = sbi_lattice_key(&cut->lattice, &order, cell->tet, link);
    sbi_lattice_ends(&cut->lattice, &order, link, ends);
    item = sbi_cut_links_find(&cut->links, &key);
    return (int)(cell->points >> ends[item >= 0 && cut->links.items[item].t < (sb_real)0.5] & 1);
}

/* 1 when a record has the material at one of its nodes. */
static int sbi_cut_has_material(const sb_cut *cut, const sbi_cut_cell *cell, int local)
{
    if (local < cut->lattice.point_count) /* a point of the lattice, which has them in the order of a tet10 */
        return (int)(cell->points >> local & 1);
    return sbi_cut_has_middle(cut, cell, local - 4);
}

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
        int first = cut->cell_of[cut->node_tets.items[k]] - 1, end = sbi_cut_end_of(cut, first);
        for (int i = first; i < end; i++) {
            const sbi_cut_cell *cell = cut->cells + i;
            int local = sbi_cut_local_of(cut, cell, node), root = sbi_cut_root(cut, cut->nodes_per_tet * i + local);
            int at = sbi_cut_class_of(cut, root);
            void *classes = cut->classes;
            int grown = sbi_cut_grow(&cut->allocator, &classes, &cut->class_capacity, cut->class_count, 1,
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
        if (old == node ? cut->classes[k].has : (cut->body->fixed[old] & ~cut->classes[k].held) == 0)
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
        int first = cut->cell_of[cut->node_tets.items[k]] - 1, end = sbi_cut_end_of(cut, first);
        for (int i = first; i < end; i++) {
            int local = sbi_cut_local_of(cut, cut->cells + i, node);
            int root = sbi_cut_root(cut, cut->nodes_per_tet * i + local);
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

/* How near an end of its link a crossing may be, of the link, for masses and stiffness. Explicit steps are as long as
 * the lightest corner of a piece allows: a sixteenth of the element's edge leaves them a third of the uncut ones. */
static sb_real sbi_cut_least(const sb_cut *cut)
{
    return sbi_body_is_implicit(cut->body) ? 0 : (sb_real)cut->lattice.intervals / 16;
}

/* What the pieces of a tet are. */
typedef struct sbi_cut_measures {
    sbi_part_moments moments[SBI_LATTICE_POINTS];
    sb_real faces[SBI_LATTICE_POINTS][4][3]; /* see sb_change_cell */
} sbi_cut_measures;

static void sbi_cut_measure(const sb_cut *cut, int tet, sbi_cut_measures *measures)
{
    sbi_parted parted;
    sbi_face_moments of_face[SBI_LATTICE_POINTS];
    sbi_cut_parted(cut, tet, &parted);
    sbi_parted_moments(&parted, sbi_cut_least(cut), measures->moments);
    for (int face = 0; face < 4 && cut->nodes_per_tet == 4; face++) {
        int corners[SB_MAX_FACE_NODES];
        sb_element_face(SB_TET4, face, corners, NULL);
        sbi_parted_face(&parted, face, of_face);
        for (int k = 0; k < parted.piece_count; k++)
            for (int i = 0; i < 3; i++)
                measures->faces[k][face][i] = of_face[k].loads[corners[i]];
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
        made.face_loads = cut->nodes_per_tet == 4 ? measures->faces[piece] : NULL;
    }
    cut->made_cells += cell->is_new;
    return cell->is_new ? sb_body_change_add_cell(change, &made, &cell->cell, error)
                        : sb_body_change_replace_cell(change, cell->cell, &made, error);
}

/* The cells of one tet's records that are others now. */
static sb_result sbi_cut_put_tet(sb_cut *cut, sb_body_change *change, int first, int end, sb_error *error)
{
    sbi_cut_measures measures;
    sb_result result = SB_OK;
    size_t nodes = (size_t)cut->nodes_per_tet * sizeof(int);
    int differs = 0;
    for (int i = first; i < end; i++)
        differs |= cut->cells[i].is_cut || memcmp(cut->cells[i].nodes, cut->cells[i].old_nodes, nodes) != 0;
    if (!differs)
        return SB_OK;
    if (end - first > 1)
        sbi_cut_measure(cut, cut->cells[first].tet, &measures);
    for (int i = first; i < end && result == SB_OK; i++)
        if (cut->cells[i].is_cut || memcmp(cut->cells[i].nodes, cut->cells[i].old_nodes, nodes) != 0)
            result = sbi_cut_put_cell(cut, change, i, end - first > 1 ? &measures : NULL, i - first, error);
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

/* ---- pieces ---- */

/* Room for the pieces that the records have more than there are; 0: no memory. */
static int sbi_cut_reserve_pieces(sb_cut *cut)
{
    int more = 0, cells = 0, grown;
    void *pieces = cut->pieces;
    for (int i = 0; i < cut->cell_count; i++) {
        more += cut->cells[i].is_new;
        cells = sbi_max_int(cells, cut->cells[i].cell + 1);
    }
    grown = sbi_cut_grow(&cut->allocator, &pieces, &cut->piece_capacity, cut->piece_count, more, sizeof *cut->pieces);
    cut->pieces = (sbi_cut_piece *)pieces;
    return grown && sbi_cut_list_grow(cut, &cut->elements, sbi_max_int(cells - cut->elements.count, 0));
}

/* Takes the pieces of a tet from its records. */
static void sbi_cut_keep_tet(sb_cut *cut, int first, int end)
{
    int tet = cut->cells[first].tet, piece = tet, last = tet;
    for (int more = end - first - sbi_cut_chain_length(cut, tet); more > 0; more--) {
        while (cut->pieces[last].next >= 0)
            last = cut->pieces[last].next;
        cut->pieces[last].next = cut->piece_count;
        cut->pieces[cut->piece_count++].next = -1;
    }
    for (int i = first; i < end; i++, piece = cut->pieces[piece].next) {
        cut->pieces[piece].points = cut->cells[i].points;
        cut->pieces[piece].cell = cut->cells[i].cell;
    }
}

static void sbi_cut_keep(sb_cut *cut)
{
    for (int first = 0, end; first < cut->cell_count; first = end) {
        end = sbi_cut_end_of(cut, first);
        sbi_cut_keep_tet(cut, first, end);
    }
}

/* ---- all of it ---- */

/* Makes the change, with records and classes found. */
static sb_result sbi_cut_change(sb_cut *cut, sb_error *error)
{
    sb_body_change *change = NULL;
    sb_result result = sb_body_change_begin(cut->body, &change, error);
    if (result == SB_OK)
        result = sbi_cut_number_nodes(cut, change, error);
    if (result == SB_OK)
        result = sbi_cut_put_cells(cut, change, error);
    if (result == SB_OK && (!sbi_cut_reserve_pieces(cut) || !sbi_cut_make_ties(cut)))
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the pieces of a cut");
    for (int i = 0; i < cut->cell_count && result == SB_OK; i++)
        sbi_cut_list_set(&cut->elements, cut->cells[i].cell, cut->cells[i].tet);
    if (result == SB_OK) {
        sbi_change_set_glue(change, cut->ties, cut->tie_count);
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
    if (!cut->touched.count)
        return;
    memset(cut->tet_marks, 0, (size_t)cut->tet_count);
    memset(cut->node_marks, 0, (size_t)cut->node_end);
    memset(cut->cell_of, 0, (size_t)cut->tet_count * sizeof(int));
    cut->touched.count = cut->parted.count = 0;
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

SBI_API sb_result sbi_cut_part(sb_cut *cut, sb_error *error)
{
    sb_result result = SB_OK;
    cut->cell_count = cut->made_nodes = cut->made_cells = 0;
    if (cut->parted.count == 0) {
        result = sbi_cut_release(cut, error);
    } else {
        if (sbi_cut_add_tets(cut)) {
            sbi_cut_join_all(cut);
            result = sbi_cut_change(cut, error);
        } else
            result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the pieces of a cut");
        if (result == SB_OK)
            sbi_cut_keep(cut);
    }
    if (result == SB_OK)
        sbi_cut_take_next_glue(cut);
    sbi_cut_clear(cut);
    return result;
}
