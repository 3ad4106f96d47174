/* needle_undo: the state of a tissue, its remesher and its needles at the start of a step, in one block. */
#include "needle_private.h"

#include <string.h>

/* Parts begin where doubles may. */
static size_t ndli_undo_aligned(size_t bytes) { return (bytes + 15) / 16 * 16; }

/* What a needle has beside its rod: its fields, and the arrays that go from step to step. */
static size_t ndli_undo_needle_size(const ndl_needle *needle, int node_count)
{
    size_t n = (size_t)node_count;
    return ndli_undo_aligned(sizeof *needle) + ndli_undo_aligned(n * sizeof(ndli_v3)) +
           ndli_undo_aligned(n * sizeof(int)) + ndli_undo_aligned(n) +
           ndli_undo_aligned(ndli_rod_snapshot_size(needle->rod, node_count));
}

static size_t ndli_undo_size(const ndl_tissue *tissue)
{
    const struct ndli_site *site = tissue->site;
    size_t sum = ndli_undo_aligned(ndli_solid_snapshot_size(tissue)) +
                 ndli_undo_aligned(ndli_remesh_snapshot_size(site->remesh));
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (site->needles[i])
            sum += ndli_undo_needle_size(site->needles[i], site->needles[i]->rod->node_count);
    return sum;
}

/* The block holds nothing between steps. */
static int ndli_undo_make_room(ndl_tissue *tissue, size_t needed)
{
    struct ndli_site *site = tissue->site;
    unsigned char *grown;
    if (needed <= site->undo_room)
        return 1;
    grown = (unsigned char *)sbi_alloc(&tissue->allocator, needed, 1);
    if (!grown)
        return 0;
    sbi_free(&tissue->allocator, site->undo);
    site->undo = grown;
    site->undo_room = needed;
    return 1;
}

NDLI_API int ndli_needle_reserve_undo(ndl_tissue *tissue, const ndl_needle *more)
{
    const struct ndli_site *site = tissue->site;
    size_t sum = ndli_undo_aligned(ndli_solid_snapshot_room(tissue)) +
                 ndli_undo_aligned(ndli_remesh_snapshot_room(site->remesh)) +
                 ndli_undo_needle_size(more, more->rod->capacity);
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (site->needles[i])
            sum += ndli_undo_needle_size(site->needles[i], site->needles[i]->rod->capacity);
    return ndli_undo_make_room(tissue, sum);
}

/* Copies `bytes` of a part to the block, or back from it, and goes on to the next part. */
static void ndli_undo_copy(unsigned char **at, void *part, size_t bytes, int back)
{
    if (bytes)
        memcpy(back ? part : (void *)*at, back ? (const void *)*at : part, bytes);
    *at += ndli_undo_aligned(bytes);
}

static void ndli_undo_copy_needle(ndl_needle *needle, int node_count, unsigned char **at, int back)
{
    size_t n = (size_t)node_count;
    ndli_undo_copy(at, needle, sizeof *needle, back);
    ndli_undo_copy(at, needle->line.contact, n * sizeof(ndli_v3), back);
    ndli_undo_copy(at, needle->path, n * sizeof(int), back);
    ndli_undo_copy(at, needle->line.state, n, back);
}

NDLI_API int ndli_needle_keep(ndl_tissue *tissue)
{
    struct ndli_site *site = tissue->site;
    size_t needed = ndli_undo_size(tissue);
    unsigned char *at;
    if (needed > site->undo_room && !ndli_undo_make_room(tissue, needed + needed / 8))
        return 0;
    at = site->undo + ndli_undo_aligned(ndli_solid_snapshot_size(tissue));
    if (!ndli_solid_snapshot(tissue, site->undo))
        return 0;
    ndli_remesh_snapshot(site->remesh, at);
    at += ndli_undo_aligned(ndli_remesh_snapshot_size(site->remesh));
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (site->needles[i]) {
            size_t rod = ndli_undo_aligned(
                ndli_rod_snapshot_size(site->needles[i]->rod, site->needles[i]->rod->node_count));
            ndli_rod_snapshot(site->needles[i]->rod, at);
            at += rod;
            ndli_undo_copy_needle(site->needles[i], site->needles[i]->rod->node_count, &at, 0);
        }
    return 1;
}

NDLI_API void ndli_needle_undo(ndl_tissue *tissue)
{
    struct ndli_site *site = tissue->site;
    unsigned char *at = site->undo;
    ndli_solid_restore(tissue, at);
    at += ndli_undo_aligned(ndli_solid_snapshot_size(tissue)); /* of the restored state, as when it was kept */
    ndli_remesh_rewind(site->remesh, at);
    at += ndli_undo_aligned(ndli_remesh_snapshot_size(site->remesh));
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (site->needles[i]) {
            ndl_rod *rod = site->needles[i]->rod;
            ndli_rod_rewind(rod, at);
            at += ndli_undo_aligned(ndli_rod_snapshot_size(rod, rod->node_count));
            ndli_undo_copy_needle(site->needles[i], rod->node_count, &at, 1);
        }
}
