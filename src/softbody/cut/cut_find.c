/* cut_find: which piece of an element has the material at a point. */
#include "cut_private.h"

/* Least of a point's barycentrics in a tet; -SB_REAL_MAX where it is flat. */
static sb_real sbi_find_depth(const sb_vec3 corners[4], sb_vec3 x)
{
    sb_vec3 a = sb_v3_sub(corners[1], corners[0]), b = sb_v3_sub(corners[2], corners[0]);
    sb_vec3 c = sb_v3_sub(corners[3], corners[0]), p = sb_v3_sub(x, corners[0]);
    sb_real volume = sb_v3_dot(a, sb_v3_cross(b, c)), first, second, third;
    if (volume == 0)
        return -SB_REAL_MAX;
    first = sb_v3_dot(p, sb_v3_cross(b, c)) / volume;
    second = sb_v3_dot(p, sb_v3_cross(c, a)) / volume;
    third = sb_v3_dot(p, sb_v3_cross(a, b)) / volume;
    return sb_min(sb_min(first, second), sb_min(third, 1 - first - second - third));
}

/* The micro-tet that a point is deepest in; the first of several. */
static int sbi_find_micro(const sbi_lattice *lattice, sb_vec3 x)
{
    sb_real deepest = -SB_REAL_MAX;
    int found = 0;
    for (int micro = 0; micro < lattice->micro_count; micro++) {
        sb_vec3 corners[4];
        sb_real depth;
        for (int v = 0; v < 4; v++) {
            sb_real at[4];
            sbi_lattice_point(lattice, lattice->micros[micro][v], at);
            corners[v] = sb_v3(at[1], at[2], at[3]);
        }
        depth = sbi_find_depth(corners, x);
        if (depth > deepest) {
            deepest = depth;
            found = micro;
        }
    }
    return found;
}

/* The piece of a tet that has a point. */
static int sbi_find_piece(const sbi_parted *parted, sb_vec3 x)
{
    sbi_flag flags[SBI_FLAGS];
    sb_real deepest = -SB_REAL_MAX;
    int count = sbi_parted_flags(parted, sbi_find_micro(parted->lattice, x), 0, flags), piece = flags[0].piece;
    for (int k = 0; k < count && count > 1; k++) {
        sb_real depth = sbi_find_depth(flags[k].corners, x);
        if (depth > deepest) {
            deepest = depth;
            piece = flags[k].piece;
        }
    }
    return piece;
}

SBI_API int sbi_cut_find_cell(void *user, int cell, const sb_real xi[3])
{
    const sb_cut *cut = (const sb_cut *)user;
    int tet = cell >= 0 && cell < cut->elements.count && !cut->stale ? cut->elements.items[cell] : -1, piece, at;
    int records = tet >= 0 && cut->changing ? cut->cell_of[tet] : 0;
    sbi_parted parted;
    if (tet < 0 || (!records && cut->pieces[tet].next < 0))
        return cell;
    sbi_parted_make(&cut->lattice, &cut->links, cut->tets + 4 * (size_t)tet, tet, &parted);
    piece = parted.piece_count > 1 ? sbi_find_piece(&parted, sb_v3(xi[0], xi[1], xi[2])) : 0;
    if (records)
        return cut->cells[records - 1 + piece].cell;
    for (at = tet; piece > 0 && cut->pieces[at].next >= 0; piece--)
        at = cut->pieces[at].next;
    return cut->pieces[at].cell;
}
