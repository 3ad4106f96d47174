/* cut_record: records of the pieces about what a call cuts, as they are to be, and which of their nodes hang
 * together.
 *
 * What is taken out has records, too, which are gone: they touch nothing, and their cells are removed. */
#include "cut_private.h"

#include <string.h>

#include "../body/rigid_private.h"

/* ---- elements ---- */

SBI_API sb_real sbi_cut_tet_volume(const sb_cut *cut, int tet)
{
    const int *nodes = cut->tets + 4 * (size_t)tet;
    const sb_vec3 *x = cut->body->reference;
    sb_vec3 e = sb_v3_sub(x[nodes[1]], x[nodes[0]]), f = sb_v3_sub(x[nodes[2]], x[nodes[0]]);
    return sb_v3_dot(sb_v3_cross(e, f), sb_v3_sub(x[nodes[3]], x[nodes[0]])) / 6;
}

/* ---- tets that have parted ---- */

SBI_API void sbi_cut_parted(const sb_cut *cut, int tet, sbi_parted *parted)
{
    sbi_parted_make(&cut->lattice, &cut->links, cut->tets + 4 * (size_t)tet, tet, parted);
}

static int sbi_cut_chain_length(const sb_cut *cut, int tet)
{
    int count = 0;
    for (int piece = sbi_cut_first_piece(cut, tet); piece >= 0; piece = cut->pieces[piece].next)
        count++;
    return count;
}

SBI_API void sbi_cut_find_parted(sb_cut *cut)
{
    sbi_parted parted;
    cut->listed.count = 0;
    for (int i = 0; i < cut->touched.count; i++) {
        int tet = cut->touched.items[i];
        sbi_cut_parted(cut, tet, &parted);
        if (parted.piece_count == sbi_cut_chain_length(cut, tet) && !(cut->tet_marks[tet] & SBI_CUT_LOSES))
            continue;
        cut->tet_marks[tet] |= SBI_CUT_PARTED;
        cut->listed.items[cut->listed.count++] = tet;
        for (int a = 0; a < cut->nodes_per_tet; a++)
            cut->node_marks[sbi_cut_tet_nodes(cut, tet)[a]] = 1;
    }
    for (int i = 0; i < cut->listed.count; i++)
        for (int a = 0; a < 4; a++) {
            int node = cut->tets[4 * (size_t)cut->listed.items[i] + (size_t)a];
            for (int k = cut->node_tets.offsets[node]; k < cut->node_tets.offsets[node + 1]; k++)
                cut->tet_marks[cut->node_tets.items[k]] |= SBI_CUT_NEAR;
        }
}

/* ---- records of the pieces around ---- */

SBI_API void sbi_cut_take_back_lost(sb_cut *cut)
{
    for (int i = 0; i < cut->loss_count; i++)
        cut->links.lost[cut->losses[i].tet] = cut->losses[i].points;
}

/* A record of a piece with these points; 0: of one that nothing is left of. */
static sbi_cut_cell *sbi_cut_add_cell(sb_cut *cut, int tet, uint64_t points, int piece, const sbi_corner_order *order)
{
    sbi_cut_cell *cell = cut->cells + cut->cell_count;
    const int *nodes = sbi_cut_piece_nodes(cut, piece);
    cell->points = points;
    cell->tet = tet;
    cell->piece = piece;
    cell->is_cut = (cut->tet_marks[tet] & SBI_CUT_PARTED) != 0;
    cell->cell = cut->pieces[piece].cell;
    cell->is_new = cell->crumb = 0;
    cell->is_gone = points == 0;
    cell->share = sb_body_cell_share(cut->body, cell->cell);
    for (int a = 0; a < cut->nodes_per_tet; a++)
        cell->old_nodes[a] = cell->nodes[a] = nodes[a];
    for (int face = 0; face < 4; face++)
        cell->marks[face] = (unsigned short)sbi_lattice_face_marks(&cut->lattice, order, face, points);
    cut->cell_count++;
    return cell;
}

/* Records of the pieces that a tet falls into, then of those that nothing is left of. */
static void sbi_cut_add_parted(sb_cut *cut, int tet, const sbi_corner_order *order)
{
    sb_real shares[SBI_LATTICE_POINTS];
    sbi_parted parted;
    sbi_cut_parted(cut, tet, &parted);
    if (cut->least_volume > 0)
        sbi_parted_shares(&parted, sbi_cut_least(cut), shares);
    for (int k = 0; k < parted.piece_count; k++) {
        int piece = tet;
        sbi_cut_cell *cell;
        while (!(cut->pieces[piece].points & parted.pieces[k]))
            piece = cut->pieces[piece].next;
        cell = sbi_cut_add_cell(cut, tet, parted.pieces[k], piece, order);
        cell->share = cut->least_volume > 0 ? shares[k] : cell->share;
    }
    for (int piece = tet; piece >= 0; piece = cut->pieces[piece].next)
        if (!(cut->pieces[piece].points & ~parted.lost))
            (void)sbi_cut_add_cell(cut, tet, 0, piece, order);
}

SBI_API int sbi_cut_add_tet(sb_cut *cut, int tet)
{
    sbi_corner_order order = sbi_corner_order_make(cut->tets + 4 * (size_t)tet);
    void *cells = cut->cells;
    int grown = sbi_cut_grow(&cut->allocator, &cells, &cut->cell_capacity, cut->cell_count, SBI_LATTICE_POINTS + 1,
                             sizeof *cut->cells);
    cut->cells = (sbi_cut_cell *)cells;
    if (!grown)
        return 0;
    if (sbi_cut_first_piece(cut, tet) < 0)
        return 1;
    cut->cell_of[tet] = cut->cell_count + 1;
    if (cut->tet_marks[tet] & SBI_CUT_PARTED) {
        sbi_cut_add_parted(cut, tet, &order);
        return 1;
    }
    for (int piece = tet; piece >= 0; piece = cut->pieces[piece].next)
        (void)sbi_cut_add_cell(cut, tet, cut->pieces[piece].points, piece, &order);
    return 1;
}

SBI_API int sbi_cut_add_tets(sb_cut *cut)
{
    for (int tet = 0; tet < cut->tet_count; tet++)
        if ((cut->tet_marks[tet] & SBI_CUT_NEAR) && !sbi_cut_add_tet(cut, tet))
            return 0;
    return sbi_cut_list_grow(cut, &cut->roots, cut->nodes_per_tet * cut->cell_count - cut->roots.count);
}

SBI_API int sbi_cut_end_of(const sb_cut *cut, int first)
{
    int end = first;
    while (end < cut->cell_count && cut->cells[end].tet == cut->cells[first].tet)
        end++;
    return end;
}

/* ---- classes ---- */

SBI_API int sbi_cut_root(const sb_cut *cut, int i)
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

SBI_API void sbi_cut_join_all(sb_cut *cut)
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

SBI_API int sbi_cut_held_axes(const sb_cut *cut, const sbi_cut_cell *cell, int node)
{
    int held = 0;
    for (int face = 0; face < 4; face++) {
        int local[SB_MAX_FACE_NODES], all = SB_XYZ, on = 0;
        int count = sb_element_face(cut->body->domain.element_type, face, local, NULL);
        for (int k = 0; k < count; k++) {
            on |= local[k] == node;
            all &= sbi_body_held_axes(cut->body, cell->old_nodes[local[k]]);
        }
        if (on && cell->marks[face] && cut->neighbours.items[4 * (size_t)cell->tet + (size_t)face] < 0)
            held |= all;
    }
    return held;
}

SBI_API int sbi_cut_local_of(const sb_cut *cut, const sbi_cut_cell *cell, int node)
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

SBI_API int sbi_cut_has_material(const sb_cut *cut, const sbi_cut_cell *cell, int local)
{
    if (local < cut->lattice.point_count) /* a point of the lattice, which has them in the order of a tet10 */
        return (int)(cell->points >> local & 1);
    return sbi_cut_has_middle(cut, cell, local - 4);
}

/* How near an end of its link a crossing may be, of the link, for masses and stiffness. Explicit steps are as long as
 * the lightest corner of a piece allows: a sixteenth of the element's edge, with what sbi_body_piece_lumps spreads,
 * leaves them more than a third of the uncut ones. */
SBI_API sb_real sbi_cut_least(const sb_cut *cut)
{
    return sbi_body_is_implicit(cut->body) ? 0 : (sb_real)cut->lattice.intervals / 16;
}
