/* cut_find: which piece of an element has the material at a point, also once what has cut the body is gone. */
#include "cut_private.h"

#include <string.h>

#include "../base/bytes.h"

/* The pieces of a tet, and where xi is in it. */
static void sbi_cut_find_in(const sb_cut *cut, int tet, const sb_real xi[3], sbi_parted *parted,
                            sb_real barycentrics[4])
{
    sbi_parted_make(&cut->lattice, &cut->links, cut->tets + 4 * (size_t)tet, tet, parted);
    barycentrics[0] = 1 - xi[0] - xi[1] - xi[2];
    barycentrics[1] = xi[0], barycentrics[2] = xi[1], barycentrics[3] = xi[2];
}

SBI_API int sbi_cut_find_cell(void *user, int cell, const sb_real xi[3])
{
    const sb_cut *cut = (const sb_cut *)user;
    int tet = cell >= 0 && cell < cut->elements.count && !cut->stale ? cut->elements.items[cell] : -1, piece, at;
    int records = tet >= 0 && cut->changing ? cut->cell_of[tet] : 0, first = records - 1;
    sb_real barycentrics[4];
    sbi_parted parted;
    if (tet < 0 || (!records && cut->pieces[tet].next < 0))
        return cell;
    sbi_cut_find_in(cut, tet, xi, &parted, barycentrics);
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

/* The same, but -1 where the material was taken out. Not within a change. */
static int sbi_cut_find_holder(void *user, int cell, const sb_real xi[3])
{
    const sb_cut *cut = (const sb_cut *)user;
    int tet = cell >= 0 && cell < cut->elements.count && !cut->stale ? cut->elements.items[cell] : -1;
    sb_real barycentrics[4];
    sbi_parted parted;
    if (tet < 0 || !cut->links.lost[tet])
        return sbi_cut_find_cell(user, cell, xi);
    sbi_cut_find_in(cut, tet, xi, &parted, barycentrics);
    if (parted.piece_count == 0 || sbi_parted_owner_at(&parted, barycentrics) == SBI_PARTED_LOST)
        return -1;
    return sbi_cut_find_cell(user, cell, xi);
}

SBI_API void sbi_cut_lend_finder(sb_cut *cut)
{
    sbi_live *live = cut->body->live;
    live->find = cut->stale ? NULL : sbi_cut_find_cell;
    live->holder = cut->stale ? NULL : sbi_cut_find_holder;
    live->find_user = cut;
    live->uncut = cut->stale ? NULL : &cut->uncut;
}

/* ---- what a destroyed cut leaves ---- */

static void sbi_cut_free_remains(sb_cut *remains)
{
    sb_allocator allocator = remains->allocator;
    if (remains->nodes != remains->tets)
        sbi_free(&allocator, remains->nodes);
    sbi_free(&allocator, remains->tets);
    sbi_free(&allocator, remains->cells_at_first);
    sbi_free(&allocator, remains->pieces);
    sbi_free(&allocator, remains->elements.items);
    sbi_free(&allocator, remains->links.items);
    sbi_free(&allocator, remains->links.table);
    sbi_free(&allocator, remains->links.lost);
    sbi_free(&allocator, remains);
}

static uint64_t sbi_cut_hash_mesh(const sb_body *body)
{
    size_t width = (size_t)body->domain.nodes_per_cell;
    uint64_t hash = 0;
    for (int e = 0; e < body->domain.cell_count; e++)
        for (size_t a = 0; a < width && sb_body_cell_in_use(body, e); a++)
            hash = sbi_hash_word(hash,
                                 ((uint64_t)(unsigned)e << 32) | (unsigned)body->domain.cells[width * (size_t)e + a]);
    return hash;
}

/* A state may bring the mesh back that they know. */
static void sbi_cut_remains_follow(void *user, const sb_body *body, const sb_mesh_change *change)
{
    sb_cut *remains = (sb_cut *)user;
    remains->stale = change || sbi_cut_hash_mesh(body) != remains->mesh_was;
    sbi_cut_lend_finder(remains);
}

static void sbi_cut_remains_end(void *user) { sbi_cut_free_remains((sb_cut *)user); }

/* A copy of items, in *to; 0: no memory. */
static int sbi_cut_copy(const sb_cut *remains, void *to, const void *from, size_t count, size_t size)
{
    void *copy = sbi_alloc(&remains->allocator, count, size);
    if (copy && count)
        memcpy(copy, from, count * size);
    memcpy(to, &copy, sizeof copy);
    return copy != NULL;
}

/* What finding needs; 0: no memory. */
static int sbi_cut_copy_finder(const sb_cut *cut, sb_cut *to)
{
    size_t tets = (size_t)cut->tet_count;
    to->body = cut->body;
    to->lattice = cut->lattice;
    to->tet_count = cut->tet_count;
    to->nodes_per_tet = cut->nodes_per_tet;
    to->elements.count = cut->elements.count;
    to->links.count = to->links.capacity = cut->links.count;
    to->links.table_size = cut->links.table_size;
    if (!sbi_cut_copy(to, &to->tets, cut->tets, tets, 4 * sizeof(int)) ||
        !sbi_cut_copy(to, &to->cells_at_first, cut->cells_at_first, tets, sizeof(int)) ||
        !sbi_cut_copy(to, &to->pieces, cut->pieces, (size_t)cut->piece_count, sizeof *cut->pieces) ||
        !sbi_cut_copy(to, &to->elements.items, cut->elements.items, (size_t)cut->elements.count, sizeof(int)) ||
        !sbi_cut_copy(to, &to->links.items, cut->links.items, (size_t)cut->links.count, sizeof *cut->links.items) ||
        !sbi_cut_copy(to, &to->links.table, cut->links.table, (size_t)cut->links.table_size, sizeof(int)) ||
        !sbi_cut_copy(to, &to->links.lost, cut->links.lost, tets, sizeof(uint64_t)))
        return 0;
    to->nodes = to->tets;
    if (cut->nodes != cut->tets)
        return sbi_cut_copy(to, &to->nodes, cut->nodes, tets, (size_t)cut->nodes_per_tet * sizeof(int));
    return 1;
}

/* They lead, so that others who follow find them as they are after a change. 0: no memory. */
static int sbi_cut_settle_remains(sb_cut *remains)
{
    sb_body_listener listener;
    remains->mesh_was = sbi_cut_hash_mesh(remains->body);
    remains->uncut.cell_count = remains->tet_count;
    remains->uncut.nodes = remains->nodes;
    remains->uncut.cells = remains->cells_at_first;
    memset(&listener, 0, sizeof listener);
    listener.user = remains;
    listener.follow = sbi_cut_remains_follow;
    listener.end = sbi_cut_remains_end;
    return sbi_live_listen(remains->body, &listener, 1, &remains->listener, NULL) == SB_OK;
}

SBI_API void sbi_cut_leave_finder(const sb_cut *cut)
{
    sbi_live *live = cut->body->live;
    sb_cut *remains = NULL;
    int parted = 0;
    live->find = NULL;
    live->holder = NULL;
    live->find_user = NULL;
    live->uncut = NULL;
    for (int tet = 0; tet < cut->tet_count && !parted; tet++)
        parted = !sbi_cut_is_whole(cut, tet);
    if (parted && !cut->stale)
        remains = (sb_cut *)sbi_alloc_zeroed(&cut->body->allocator, 1, sizeof *remains);
    if (!remains)
        return;
    remains->allocator = cut->body->allocator;
    remains->uncut = cut->uncut;
    if (sbi_cut_copy_finder(cut, remains) && sbi_cut_settle_remains(remains))
        sbi_cut_lend_finder(remains);
    else
        sbi_cut_free_remains(remains);
}

SBI_API void sbi_cut_drop_finder(sb_body *body)
{
    sb_cut *remains = (sb_cut *)body->live->find_user;
    if (!remains)
        return;
    sb_body_unlisten(body, remains->listener);
    sbi_cut_free_remains(remains);
}
