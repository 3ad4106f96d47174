/* needle_undo: the state of a body, its remesher and its needles at the start of a step, or of one of its substeps. */
#include "needle_private.h"

#include "../softbody/body/state_part.h"
#include "../softbody/body/step_touch.h"

#include <string.h>

/* Parts begin where doubles may. */
static size_t ndli_undo_aligned(size_t bytes) { return (bytes + 15) / 16 * 16; }

/* What a needle has beside its rod: its fields, and the arrays that go from step to step. */
static size_t ndli_undo_needle_size(const ndl_needle *needle, int node_count, int point_count)
{
    size_t n = (size_t)node_count, points = (size_t)point_count;
    return ndli_undo_aligned(sizeof *needle) + 2 * ndli_undo_aligned(n * sizeof(ndli_v3)) +
           ndli_undo_aligned(n * sizeof(int)) + ndli_undo_aligned(n) + ndli_undo_aligned(n * sizeof(double)) +
           ndli_undo_aligned(points * sizeof(ndli_v3)) + ndli_undo_aligned(points * sizeof(double)) +
           ndli_undo_aligned(points * sizeof(int)) + ndli_undo_aligned(ndli_rod_snapshot_size(needle->rod, node_count));
}

/* What contact keeps of tools. */
static size_t ndli_undo_touch_size(const struct ndli_site *site)
{
    const sbi_touch *touch = sbi_body_get_touch(site->body);
    return touch ? ndli_undo_aligned(touch->kept_size(touch->user)) : 0;
}

static size_t ndli_undo_remesh_size(const struct ndli_site *site)
{
    return site->embeds ? 0 : ndli_remesh_snapshot_size(site->remesh);
}

/* body: bytes of the body's part. */
static size_t ndli_undo_size(const struct ndli_site *site, size_t body)
{
    size_t sum = ndli_undo_aligned(body) + ndli_undo_touch_size(site) + ndli_undo_aligned(ndli_undo_remesh_size(site));
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (site->needles[i])
            sum += ndli_undo_needle_size(site->needles[i], site->needles[i]->rod->node_count,
                                         site->needles[i]->track.count);
    return sum;
}

static int ndli_undo_make_room(struct ndli_site *site, ndli_kept *kept, size_t needed)
{
    unsigned char *grown;
    if (needed <= kept->room)
        return 1;
    grown = (unsigned char *)sbi_alloc(&site->allocator, needed, 1);
    if (!grown)
        return 0;
    sbi_free(&site->allocator, kept->bytes);
    kept->bytes = grown;
    kept->room = needed;
    memset(&kept->held, 0, sizeof kept->held);
    return 1;
}

static int ndli_undo_make_all_room(struct ndli_site *site, size_t needed)
{
    for (int i = 0; i < NDLI_KEPT_COUNT; i++)
        if (!ndli_undo_make_room(site, site->kept + i, needed))
            return 0;
    return 1;
}

NDLI_API int ndli_needle_reserve_undo(struct ndli_site *site, const ndl_needle *more)
{
    size_t sum = ndli_undo_aligned(sbi_body_snapshot_size(site->body) / 4 * 5) + ndli_undo_touch_size(site) +
                 ndli_undo_aligned(site->embeds ? 0 : ndli_remesh_snapshot_room(site->remesh));
    sum += more ? ndli_undo_needle_size(more, more->rod->capacity, more->track.capacity) : 0;
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (site->needles[i])
            sum += ndli_undo_needle_size(site->needles[i], site->needles[i]->rod->capacity,
                                         site->needles[i]->track.capacity);
    return ndli_undo_make_all_room(site, sum);
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
    size_t n = (size_t)node_count, points;
    ndli_undo_copy(at, needle, sizeof *needle, back);
    points = (size_t)needle->track.count;
    ndli_undo_copy(at, needle->line.contact, n * sizeof(ndli_v3), back);
    ndli_undo_copy(at, needle->gap, n * sizeof(ndli_v3), back);
    ndli_undo_copy(at, needle->path, n * sizeof(int), back);
    ndli_undo_copy(at, needle->line.state, n, back);
    ndli_undo_copy(at, needle->arc, needle->arc ? n * sizeof(double) : 0, back);
    ndli_undo_copy(at, needle->track.X, points * sizeof(ndli_v3), back);
    ndli_undo_copy(at, needle->track.arc, points * sizeof(double), back);
    ndli_undo_copy(at, needle->track.elements, points * sizeof(int), back);
}

NDLI_API int ndli_needle_keep(struct ndli_site *site, ndli_keeping which)
{
    ndli_kept *kept = site->kept + which;
    const sbi_touch *touch = sbi_body_get_touch(site->body);
    size_t body = sbi_body_snapshot_size(site->body), needed = ndli_undo_size(site, body);
    unsigned char *at;
    if (needed > kept->room && !ndli_undo_make_all_room(site, needed + needed / 8))
        return 0;
    kept->body = body;
    at = kept->bytes;
    sbi_body_snapshot(site->body, at, &kept->held);
    at += ndli_undo_aligned(body);
    if (touch && !touch->keep(touch->user, at))
        return 0;
    at += ndli_undo_touch_size(site);
    if (!site->embeds)
        ndli_remesh_snapshot(site->remesh, at);
    at += ndli_undo_aligned(ndli_undo_remesh_size(site));
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (site->needles[i]) {
            ndl_rod *rod = site->needles[i]->rod;
            ndli_rod_snapshot(rod, at);
            at += ndli_undo_aligned(ndli_rod_snapshot_size(rod, rod->node_count));
            ndli_undo_copy_needle(site->needles[i], rod->node_count, &at, 0);
        }
    return 1;
}

/* The body with what touches it; 0: no memory. */
static int ndli_undo_rewind_body(struct ndli_site *site, const ndli_kept *kept)
{
    const sbi_touch *touch = sbi_body_get_touch(site->body);
    sb_result result;
    if (!site->embeds)
        ndli_remesh_set_own(site->remesh, 1);
    result = sbi_body_rewind(site->body, kept->bytes, kept->body, NULL);
    if (!site->embeds)
        ndli_remesh_set_own(site->remesh, 0);
    return result == SB_OK && (!touch || touch->rewind(touch->user, kept->bytes + ndli_undo_aligned(kept->body)));
}

NDLI_API sb_result ndli_needle_undo(struct ndli_site *site, ndli_keeping which, sb_error *error)
{
    const ndli_kept *kept = site->kept + which;
    unsigned char *at = kept->bytes + ndli_undo_aligned(kept->body) + ndli_undo_touch_size(site);
    site->undo_waits = !ndli_undo_rewind_body(site, kept);
    if (site->undo_waits)
        return sbi_fail(error, SB_ERROR_MEMORY,
                        "no memory to take the failed step back: that comes first in the next step");
    if (!site->embeds)
        ndli_remesh_rewind(site->remesh, at);
    at += ndli_undo_aligned(ndli_undo_remesh_size(site));
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (site->needles[i]) {
            ndl_rod *rod = site->needles[i]->rod;
            ndli_rod_rewind(rod, at);
            at += ndli_undo_aligned(ndli_rod_snapshot_size(rod, rod->node_count));
            ndli_undo_copy_needle(site->needles[i], rod->node_count, &at, 1);
        }
    return SB_OK;
}

NDLI_API sb_result ndli_needle_finish_undo(struct ndli_site *site, sb_error *error)
{
    sb_result result;
    if (!site->undo_waits)
        return SB_OK;
    result = ndli_needle_undo(site, NDLI_KEPT_STEP, error);
    for (int i = 0; i < NDL_MAX_NEEDLES && result == SB_OK; i++)
        if (site->needles[i])
            ndli_rod_publish(site->needles[i]->rod);
    return result;
}

NDLI_API sb_result ndli_needle_look(struct ndli_site *site, sb_error *error)
{
    int stale = ndli_site_is_stale(site);
    sb_result result = ndli_site_look(site, error);
    if (result == SB_OK && !ndli_site_reserve_places(site)) /* a cut may have made the body larger */
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the nodes of a body that has grown");
    for (int i = 0; i < NDL_MAX_NEEDLES && stale && result == SB_OK; i++)
        if (site->needles[i]) {
            if (site->needles[i]->line.count > 0)
                site->needles[i]->lost = NDLI_LOST_MESH;
            ndli_held_leave(site->needles[i]);
            site->needles[i]->shallow = 0;
        }
    return result;
}
