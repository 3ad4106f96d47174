/* cut_find: which piece of an element has the material at a point. */
#include "cut_private.h"

SBI_API int sbi_cut_find_cell(void *user, int cell, const sb_real xi[3])
{
    const sb_cut *cut = (const sb_cut *)user;
    int tet = cell >= 0 && cell < cut->elements.count && !cut->stale ? cut->elements.items[cell] : -1, piece, at;
    int records = tet >= 0 && cut->changing ? cut->cell_of[tet] : 0, first = records - 1;
    sb_real barycentrics[4];
    sbi_parted parted;
    if (tet < 0 || (!records && cut->pieces[tet].next < 0))
        return cell;
    sbi_parted_make(&cut->lattice, &cut->links, cut->tets + 4 * (size_t)tet, tet, &parted);
    barycentrics[0] = 1 - xi[0] - xi[1] - xi[2];
    barycentrics[1] = xi[0], barycentrics[2] = xi[1], barycentrics[3] = xi[2];
    if (parted.piece_count == 0)
        return cell;
    piece = parted.piece_count > 1 ? sbi_parted_piece_at(&parted, barycentrics) : 0;
    if (records && cut->cells[first + piece].cell < 0) /* it is a crumb: the first piece that stays */
        for (piece = 0; piece < parted.piece_count - 1 && cut->cells[first + piece].cell < 0;)
            piece++;
    if (records)
        return cut->cells[first + piece].cell < 0 ? cell : cut->cells[first + piece].cell;
    for (at = tet; piece > 0 && cut->pieces[at].next >= 0; piece--)
        at = cut->pieces[at].next;
    return cut->pieces[at].cell;
}
