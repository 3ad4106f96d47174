/* remesh_state: what a remesher knows: its memory, in undo, in the saved state of its body and in its recording. */
#include "remesh_private.h"

#include <limits.h>
#include <string.h>

#include "../softbody/body/state_part.h"
#include "image.h"

/* ---- memory ---- */

static int ndli_remesh_grow(ndl_remesh *r, void **array, int *capacity, int used, int needed, size_t size)
{
    size_t room = (size_t)needed + (size_t)needed / 2;
    void *grown;
    if (needed <= *capacity)
        return 1;
    grown = sbi_alloc(&r->def.allocator, room, size);
    if (!grown)
        return 0;
    if (used)
        memcpy(grown, *array, (size_t)used * size);
    sbi_free(&r->def.allocator, *array);
    *array = grown;
    *capacity = (int)room;
    return 1;
}

NDLI_API int ndli_remesh_make_room(ndl_remesh *r, ndli_needle *needle, const int counts[3])
{
    void *nodes = needle->nodes, *stack = needle->stack, *pool = needle->pool, *leaving = r->leaving;
    int splits = 0, good = ndli_remesh_grow(r, &nodes, &needle->node_capacity, needle->count, counts[0], sizeof(int));
    needle->nodes = (int *)nodes;
    good = good && ndli_remesh_grow(r, &stack, &needle->stack_capacity, needle->depth, counts[1], sizeof(ndli_split));
    needle->stack = (ndli_split *)stack;
    good = good && ndli_remesh_grow(r, &pool, &needle->pool_capacity, needle->pool_count, counts[2], sizeof(int));
    needle->pool = (int *)pool;
    for (int i = 0; i < r->def.max_needles; i++)
        splits += r->needles[i].stack_capacity;
    good = good && ndli_remesh_grow(r, &leaving, &r->leaving_capacity, 0, splits, sizeof(ndli_leaving));
    r->leaving = (ndli_leaving *)leaving;
    return good;
}

NDLI_API void ndli_remesh_free_knowledge(ndl_remesh *r)
{
    if (!r)
        return;
    for (int i = 0; r->needles && i < r->def.max_needles; i++) {
        sbi_free(&r->def.allocator, r->needles[i].nodes);
        sbi_free(&r->def.allocator, r->needles[i].stack);
        sbi_free(&r->def.allocator, r->needles[i].pool);
    }
    sbi_free(&r->def.allocator, r->needles);
    sbi_free(&r->def.allocator, r->leaving);
    ndli_topology_free(&r->topology);
}

/* ---- the image ---- */

typedef struct ndli_remesh_head {
    double smooth_below, release_above, entry_slip;
    uint64_t mesh; /* hash of the mesh; 0 in snapshots */
    int order, max_needles, interfaces, max_smoothed, release_cursor;
    int stale; /* 1: the image ends here; nothing is known of the mesh that the body has got from others */
} ndli_remesh_head;

/* Free slots at the end do not count: they may have been merged. */
static uint64_t ndli_remesh_hash_mesh(const ndli_topology *mesh)
{
    size_t nodes = (size_t)mesh->node_end, tets = (size_t)mesh->tet_end;
    uint64_t hash;
    while (nodes > 0 && !mesh->node_flags[nodes - 1])
        nodes--;
    while (tets > 0 && mesh->tets[4 * (tets - 1)] < 0)
        tets--;
    hash = ndli_image_hash(nodes, mesh->tets, tets * 4 * sizeof(int));
    return ndli_image_hash(hash, mesh->X, nodes * sizeof(sb_vec3));
}

static void ndli_remesh_fill_head(const ndl_remesh *r, ndli_remesh_head *h)
{
    memset(h, 0, sizeof *h);
    h->smooth_below = (double)r->def.smooth_below;
    h->release_above = (double)r->def.release_above;
    h->entry_slip = (double)r->def.entry_slip;
    h->order = NDLI_IMAGE_ORDER;
    h->max_needles = r->def.max_needles;
    h->interfaces = (int)r->def.interfaces;
    h->max_smoothed = r->def.max_smoothed;
    h->release_cursor = r->stale ? 0 : r->release_cursor;
    h->stale = r->stale;
}

/* A split's simplex in four places, those that it does not use 0. */
static void ndli_remesh_walk_split(ndli_split *split, ndli_image *image)
{
    ndli_split whole;
    memset(&whole, 0, sizeof whole);
    if (split && !image->in) {
        whole = *split;
        for (int i = whole.size; i < 4; i++)
            whole.simplex[i] = 0;
    }
    ndli_image_part(image, &whole, 1, sizeof whole);
    if (image->in)
        *split = whole;
}

/* counts: [3] nodes, splits, pool */
static void ndli_remesh_walk_needle(ndli_needle *needle, const int *counts, ndli_image *image)
{
    ndli_image_part(image, needle->nodes, (size_t)counts[0], sizeof(int));
    for (int i = 0; i < counts[1]; i++) /* measuring: there may be no stack */
        ndli_remesh_walk_split(needle->stack ? needle->stack + i : NULL, image);
    ndli_image_part(image, needle->pool, (size_t)counts[2], sizeof(int));
}

/* Measures or writes. */
static void ndli_remesh_write(const ndl_remesh *r, uint64_t mesh, ndli_image *image)
{
    ndli_remesh_head head;
    ndli_topology topology = *r->mesh;
    int counts[NDLI_TOPOLOGY_COUNTS];
    ndli_remesh_fill_head(r, &head);
    head.mesh = mesh;
    ndli_image_part(image, &head, 1, sizeof head);
    if (r->stale)
        return;
    ndli_topology_counts(&topology, counts);
    ndli_image_part(image, counts, NDLI_TOPOLOGY_COUNTS, sizeof(int));
    ndli_topology_walk(&topology, counts, image);
    for (int i = 0; i < r->def.max_needles; i++) {
        int sizes[4] = {r->needles[i].count, r->needles[i].depth, r->needles[i].pool_count, 0};
        ndli_image_part(image, sizes, 4, sizeof(int));
        ndli_remesh_walk_needle(r->needles + i, sizes, image);
    }
}

NDLI_API size_t ndli_remesh_snapshot_size(const ndl_remesh *r)
{
    ndli_image image;
    memset(&image, 0, sizeof image);
    ndli_remesh_write(r, 0, &image);
    return image.used;
}

NDLI_API size_t ndli_remesh_snapshot_room(const ndl_remesh *r)
{
    ndli_topology topology = *r->mesh;
    ndli_image image;
    int counts[NDLI_TOPOLOGY_COUNTS] = {0, 0, 0, 0};
    size_t sum;
    memset(&image, 0, sizeof image);
    counts[0] = counts[1] = topology.node_capacity;
    ndli_topology_walk(&topology, counts, &image);
    sum = ndli_image_room(sizeof(ndli_remesh_head)) + ndli_image_room(sizeof counts) + image.used;
    for (int i = 0; i < r->def.max_needles; i++) {
        const ndli_needle *needle = r->needles + i;
        sum += ndli_image_room(4 * sizeof(int)) + ndli_image_room((size_t)needle->node_capacity * sizeof(int)) +
               ndli_image_room((size_t)needle->stack_capacity * sizeof(ndli_split)) +
               ndli_image_room((size_t)needle->pool_capacity * sizeof(int));
    }
    return sum;
}

NDLI_API void ndli_remesh_snapshot(const ndl_remesh *r, void *buffer)
{
    ndli_image image;
    memset(&image, 0, sizeof image);
    image.out = (unsigned char *)buffer;
    ndli_remesh_write(r, 0, &image);
}

/* Takes an image that is good, once the body has the mesh that goes with it. */
static void ndli_remesh_read(ndl_remesh *r, const sb_body *body, const void *buffer)
{
    ndli_remesh_head head;
    ndli_image image;
    int counts[NDLI_TOPOLOGY_COUNTS];
    memset(&head, 0, sizeof head);
    memset(counts, 0, sizeof counts);
    memset(&image, 0, sizeof image);
    image.in = (const unsigned char *)buffer;
    ndli_image_part(&image, &head, 1, sizeof head);
    r->release_cursor = head.release_cursor;
    ndli_image_part(&image, counts, NDLI_TOPOLOGY_COUNTS, sizeof(int));
    ndli_topology_walk(r->mesh, counts, &image);
    ndli_topology_recall(r->mesh, counts, body);
    for (int i = 0; i < r->def.max_needles; i++) {
        int sizes[4];
        ndli_image_part(&image, sizes, 4, sizeof(int));
        ndli_remesh_walk_needle(r->needles + i, sizes, &image);
        r->needles[i].count = sizes[0];
        r->needles[i].depth = sizes[1];
        r->needles[i].pool_count = sizes[2];
    }
}

NDLI_API void ndli_remesh_rewind(ndl_remesh *r, const void *buffer)
{
    ndli_remesh_read(r, r->body, buffer);
    r->stale = 0;
}

/* Whether the image's splits name slots that there are, and pieces of the pool that there are. */
static int ndli_remesh_split_holds(const ndli_topology *mesh, const ndli_split *s, int pool_count)
{
    if (s->node < 0 || s->node >= mesh->node_end || s->size < 2 || s->size > 4 || s->first < 0 || s->count < 1 ||
        s->count > INT_MAX / 8 || s->first > pool_count - s->size * s->count)
        return 0;
    for (int i = 0; i < s->size; i++) {
        if (s->simplex[i] < 0 || s->simplex[i] >= mesh->node_end)
            return 0;
        for (int j = 0; j < i; j++)
            if (s->simplex[i] == s->simplex[j])
                return 0;
    }
    return 1;
}

static int ndli_remesh_slots_hold(const unsigned char *slots, int count, int end)
{
    for (int i = 0; i < count; i++) {
        int slot = ndli_image_int(slots, (size_t)i);
        if (slot < 0 || slot >= end)
            return 0;
    }
    return 1;
}

/* Checks a needle of the image that has `left` bytes left, and returns how many are the needle's; 0: damaged. counts:
 * out */
static size_t ndli_remesh_needle_holds(const ndli_topology *mesh, const unsigned char *in, size_t left, int counts[4])
{
    ndli_needle none;
    ndli_image image;
    size_t stack, pool;
    memset(&none, 0, sizeof none);
    memset(&image, 0, sizeof image);
    image.used = 4 * sizeof(int);
    if (left < image.used)
        return 0;
    memcpy(counts, in, 4 * sizeof(int));
    if (counts[0] < 0 || counts[1] < 0 || counts[2] < 0 || (size_t)counts[0] > left / sizeof(int) ||
        (size_t)counts[1] > left / sizeof(ndli_split) || (size_t)counts[2] > left / sizeof(int))
        return 0;
    stack = image.used + ((size_t)counts[0] * sizeof(int) + 7) / 8 * 8;
    pool = stack + (size_t)counts[1] * sizeof(ndli_split);
    ndli_remesh_walk_needle(&none, counts, &image);
    if (image.overflow || image.used > left ||
        !ndli_remesh_slots_hold(in + 4 * sizeof(int), counts[0], mesh->node_end) ||
        !ndli_remesh_slots_hold(in + pool, counts[2], mesh->tet_end))
        return 0;
    for (int i = 0; i < counts[1]; i++) {
        ndli_split split;
        memcpy(&split, in + stack + (size_t)i * sizeof split, sizeof split);
        if (!ndli_remesh_split_holds(mesh, &split, counts[2]))
            return 0;
    }
    return image.used;
}

/* ---- the rehearsal of an image ----
 * Undoing splits trusts the stacks: tets and nodes that it takes out must be those that the splits made. So all splits
 * of an image are undone on a copy of the topology first. */
typedef struct ndli_rehearsal {
    const ndli_topology *mesh;
    const unsigned char *owners, *flags; /* [node_end] of the image */
    int node_end;
    int *tets;               /* [tet_end][4]; first -1: not in use */
    int *stars;              /* [node_end] tets of a node; -1: undone */
    int *takers;             /* [tet_end] needle whose splits made the tet, or -1 */
    unsigned char *threaded; /* [node_end] 1: on a needle */
} ndli_rehearsal;

static void ndli_rehearsal_count(ndli_rehearsal *h, const int nodes[4], int step)
{
    for (int c = 0; c < 4; c++)
        h->stars[nodes[c]] += step;
}

/* Parts of one tet that was cut become that tet again; 0: they are not what a cut leaves. */
static int ndli_rehearsal_join(ndli_rehearsal *h, const ndli_split *s, const int *parts, int needle)
{
    int *first = h->tets + 4 * (size_t)parts[0], whole[4];
    for (int j = 0; j < s->size; j++) {
        if (h->takers[parts[j]] != -1 && h->takers[parts[j]] != needle)
            return 0;
        h->takers[parts[j]] = needle;
    }
    if (first[0] < 0 || !ndli_remesh_has(first, s->node) || ndli_remesh_has(first, s->simplex[0]))
        return 0;
    for (int c = 0; c < 4; c++)
        whole[c] = first[c] == s->node ? s->simplex[0] : first[c];
    if (!ndli_remesh_holds(whole, s->simplex, s->size))
        return 0;
    for (int j = 1; j < s->size; j++) {
        int *part = h->tets + 4 * (size_t)parts[j];
        for (int c = 0; c < 4; c++)
            if (part[c] != (whole[c] == s->simplex[j] ? s->node : whole[c]))
                return 0;
        ndli_rehearsal_count(h, part, -1);
        part[0] = -1;
    }
    ndli_rehearsal_count(h, first, -1);
    ndli_rehearsal_count(h, whole, 1);
    memcpy(first, whole, sizeof whole);
    return 1;
}

/* Undoes the stack of a needle, whose splits and pool the image holds from these places on. */
static int ndli_rehearsal_undo(ndli_rehearsal *h, const unsigned char *stack, int depth, const unsigned char *pool,
                               int pool_count, int needle)
{
    int end = pool_count;
    for (int i = depth - 1; i >= 0; i--) {
        ndli_split s;
        memcpy(&s, stack + (size_t)i * sizeof s, sizeof s);
        if (s.first + s.size * s.count != end || s.node >= h->node_end || !(h->flags[s.node] & NDLI_NODE_CREATED) ||
            h->stars[s.simplex[0]] < 1)
            return 0;
        end = s.first;
        for (int g = 0; g < s.count; g++) {
            int parts[4];
            memcpy(parts, pool + (size_t)(s.first + s.size * g) * sizeof(int), (size_t)s.size * sizeof(int));
            if (!ndli_rehearsal_join(h, &s, parts, needle))
                return 0;
        }
        if (h->stars[s.node] != 0)
            return 0;
        h->stars[s.node] = -1;
    }
    return end == 0;
}

/* Nodes of a needle, entry first: its own, each once, joined by edges. */
static int ndli_rehearsal_thread(ndli_rehearsal *h, const unsigned char *nodes, int count, int needle)
{
    const ndli_topology *mesh = h->mesh;
    for (int i = 0; i < count; i++) {
        int node = ndli_image_int(nodes, (size_t)i), joined = i == 0;
        if (node >= h->node_end || !(h->flags[node] & NDLI_NODE_NEEDLE) ||
            ndli_image_int(h->owners, (size_t)node) != needle || h->threaded[node])
            return 0;
        h->threaded[node] = 1;
        for (int k = joined ? -1 : mesh->node_star[node]; k >= 0 && !joined; k = mesh->corner_next[k])
            joined = ndli_remesh_has(mesh->tets + 4 * (size_t)(k / 4), ndli_image_int(nodes, (size_t)i - 1));
        if (!joined)
            return 0;
    }
    return 1;
}

static void ndli_rehearsal_free(const ndl_remesh *r, ndli_rehearsal *h)
{
    sbi_free(&r->def.allocator, h->tets);
    sbi_free(&r->def.allocator, h->stars);
    sbi_free(&r->def.allocator, h->takers);
    sbi_free(&r->def.allocator, h->threaded);
}

/* 0: no memory. */
static int ndli_rehearsal_begin(const ndl_remesh *r, ndli_rehearsal *h)
{
    size_t nodes = (size_t)r->mesh->node_end, tets = (size_t)r->mesh->tet_end;
    h->mesh = r->mesh;
    h->tets = (int *)sbi_alloc(&r->def.allocator, tets, 4 * sizeof(int));
    h->stars = (int *)sbi_alloc_zeroed(&r->def.allocator, nodes, sizeof(int));
    h->takers = (int *)sbi_alloc(&r->def.allocator, tets, sizeof(int));
    h->threaded = (unsigned char *)sbi_alloc_zeroed(&r->def.allocator, nodes, 1);
    if (!h->tets || !h->stars || !h->takers || !h->threaded)
        return 0;
    memcpy(h->tets, r->mesh->tets, tets * 4 * sizeof(int));
    for (size_t t = 0; t < tets; t++) {
        h->takers[t] = -1;
        if (h->tets[4 * t] >= 0)
            ndli_rehearsal_count(h, h->tets + 4 * t, 1);
    }
    return 1;
}

/* Every needle of an image whose indices are in their ranges. */
static sb_result ndli_rehearsal_play(const ndl_remesh *r, ndli_rehearsal *h, const unsigned char *in, sb_error *error)
{
    for (int i = 0; i < r->def.max_needles; i++) {
        const unsigned char *nodes = in + 4 * sizeof(int), *stack, *pool;
        int counts[4];
        memcpy(counts, in, sizeof counts);
        stack = nodes + ndli_image_room((size_t)counts[0] * sizeof(int));
        pool = stack + (size_t)counts[1] * sizeof(ndli_split);
        if (!ndli_rehearsal_thread(h, nodes, counts[0], i) ||
            !ndli_rehearsal_undo(h, stack, counts[1], pool, counts[2], i))
            return sbi_fail(error, SB_ERROR_FORMAT,
                            "the saved remesher is damaged: needle %d's nodes or splits are not "
                            "those of the body",
                            i);
        in = pool + ndli_image_room((size_t)counts[2] * sizeof(int));
    }
    for (int i = 0; i < h->node_end; i++)
        if (h->threaded[i] != !!(h->flags[i] & NDLI_NODE_NEEDLE) ||
            (h->stars[i] >= 0 && (h->flags[i] & NDLI_NODE_CREATED)))
            return sbi_fail_node(error, SB_ERROR_FORMAT, i,
                                 "the saved remesher is damaged: it knows nothing of the "
                                 "needle or the split of node %d",
                                 i);
    return SB_OK;
}

/* Where the needles of an image begin; 0: its counts are none. counts: out. */
static size_t ndli_remesh_needles_at(const ndl_remesh *r, const unsigned char *in, size_t size, int *counts)
{
    ndli_topology topology = *r->mesh;
    ndli_image image;
    size_t at = sizeof(ndli_remesh_head);
    if (size < at + NDLI_TOPOLOGY_COUNTS * sizeof(int))
        return 0;
    memcpy(counts, in + at, NDLI_TOPOLOGY_COUNTS * sizeof(int));
    if (counts[0] < 0 || counts[0] > topology.node_end || counts[1] < 0 || counts[1] > counts[0] || counts[2] < 0 ||
        counts[3] < 0 || counts[2] > topology.node_capacity || counts[3] > topology.tet_capacity)
        return 0;
    memset(&image, 0, sizeof image);
    image.used = at + NDLI_TOPOLOGY_COUNTS * sizeof(int);
    ndli_topology_walk(&topology, counts, &image);
    return image.overflow || image.used > size ? 0 : image.used;
}

static sb_result ndli_remesh_rehearse(const ndl_remesh *r, const unsigned char *in, size_t size, sb_error *error)
{
    ndli_rehearsal rehearsal;
    sb_result result;
    int counts[NDLI_TOPOLOGY_COUNTS];
    size_t needles = ndli_remesh_needles_at(r, in, size, counts);
    memset(&rehearsal, 0, sizeof rehearsal);
    rehearsal.owners =
        in + sizeof(ndli_remesh_head) + sizeof counts + ndli_image_room((size_t)counts[0] * sizeof(sb_vec3));
    rehearsal.flags = rehearsal.owners + ndli_image_room((size_t)counts[0] * sizeof(int));
    rehearsal.node_end = counts[0];
    result = ndli_rehearsal_begin(r, &rehearsal)
                 ? ndli_rehearsal_play(r, &rehearsal, in + needles, error)
                 : sbi_fail(error, SB_ERROR_MEMORY, "out of memory to check the splits of a saved remesher");
    ndli_rehearsal_free(r, &rehearsal);
    return result;
}

static sb_result ndli_remesh_check_head(const ndl_remesh *r, const ndli_remesh_head *head, sb_error *error)
{
    ndli_remesh_head own;
    ndli_remesh_fill_head(r, &own);
    if (head->order != NDLI_IMAGE_ORDER)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the saved remesher is of a machine with another order of bytes");
    if (head->smooth_below != own.smooth_below || head->release_above != own.release_above ||
        head->entry_slip != own.entry_slip || head->max_needles != own.max_needles ||
        head->interfaces != own.interfaces || head->max_smoothed != own.max_smoothed)
        return sbi_fail(error, SB_ERROR_STATE, "the saved remesher was made from another def");
    if (head->stale)
        return SB_OK;
    if (head->mesh != ndli_remesh_hash_mesh(r->mesh))
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher is damaged: it is not of the body's mesh");
    if (head->release_cursor < 0 || head->release_cursor >= r->mesh->original_nodes) /* only those are displaced */
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher is damaged: it goes on at displaced node %d",
                        head->release_cursor);
    return SB_OK;
}

/* Checks what follows an image's head; room = 1: makes room for the needles, which the checks have passed. */
static sb_result ndli_remesh_pass(ndl_remesh *r, const unsigned char *in, size_t size, int room, sb_error *error)
{
    int memory[NDLI_TOPOLOGY_COUNTS];
    sb_result result = SB_OK;
    size_t at = ndli_remesh_needles_at(r, in, size, memory);
    if (at == 0)
        result = sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher has counts out of their range");
    if (result == SB_OK && !room)
        result = ndli_topology_check_memory(r->mesh, memory, in + sizeof(ndli_remesh_head) + sizeof memory,
                                            r->def.max_needles, error);
    for (int i = 0; result == SB_OK && i < r->def.max_needles; i++) {
        int counts[4];
        size_t used = ndli_remesh_needle_holds(r->mesh, in + at, size - at, counts);
        at += used;
        if (!used)
            return sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher is damaged at needle %d", i);
        if (room && !ndli_remesh_make_room(r, r->needles + i, counts))
            return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the stack of needle %d", i);
    }
    if (result == SB_OK && at != size)
        result = sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher has another size than its counts tell");
    return result;
}

/* ---- the part of the body's state ---- */

/* By its name it comes before that of the needles, which are checked against it. */
static const char ndli_remesh_name[] = "mesher";
enum { NDLI_REMESH_VERSION = 1 };

static void ndli_remesh_save_part(const void *user, sbi_state_out *out)
{
    const ndl_remesh *r = (const ndl_remesh *)user;
    ndli_image image;
    memset(&image, 0, sizeof image);
    image.state = out;
    ndli_remesh_write(r, r->stale ? 0 : ndli_remesh_hash_mesh(r->mesh), &image);
    out->overflow |= image.overflow;
}

static void ndli_remesh_give_up_part(void *user)
{
    ndl_remesh *r = (ndl_remesh *)user;
    ndli_remesh_free_knowledge(r->staged);
    if (r->staged)
        sbi_free(&r->def.allocator, r->staged);
    r->staged = NULL;
}

/* What needles had reserved, so that steps after a load take no more memory than before it. */
static int ndli_remesh_stage_room(const ndl_remesh *r)
{
    int good = 1;
    for (int i = 0; good && i < r->def.max_needles; i++) {
        const ndli_needle *needle = r->needles + i;
        int counts[3];
        counts[0] = needle->node_capacity / 3 * 2; /* it takes half as many again */
        counts[1] = needle->stack_capacity / 3 * 2;
        counts[2] = needle->pool_capacity / 3 * 2;
        good = ndli_remesh_make_room(r->staged, r->staged->needles + i, counts);
    }
    return good;
}

/* A remesher of the body that has nothing but its knowledge. */
static sb_result ndli_remesh_stage(ndl_remesh *r, const sb_body *body, sb_error *error)
{
    ndl_remesh *staged = (ndl_remesh *)sbi_alloc_zeroed(&r->def.allocator, 1, sizeof *staged);
    r->staged = staged;
    if (staged) {
        staged->def = r->def;
        staged->mesh = &staged->topology;
        staged->topology.allocator = r->def.allocator;
        staged->needles =
            (ndli_needle *)sbi_alloc_zeroed(&r->def.allocator, (size_t)r->def.max_needles, sizeof(ndli_needle));
        if (staged->needles && ndli_topology_read(staged->mesh, body) && ndli_remesh_stage_room(r))
            return SB_OK;
    }
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a saved remesher");
}

static sb_result ndli_remesh_check_part(void *user, const sb_body *body, const unsigned char *bytes, size_t size,
                                        sb_error *error)
{
    ndl_remesh *r = (ndl_remesh *)user;
    ndli_remesh_head head;
    sb_result result;
    if (size < sizeof head)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher ends in its head");
    memcpy(&head, bytes, sizeof head);
    result = ndli_remesh_stage(r, body, error);
    if (result == SB_OK)
        result = ndli_remesh_check_head(r->staged, &head, error);
    if (result == SB_OK && head.stale && (head.stale != 1 || size != sizeof head))
        result = sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher is damaged in its head");
    if (result == SB_OK && !head.stale)
        result = ndli_remesh_pass(r->staged, bytes, size, 0, error);
    if (result == SB_OK && !head.stale)
        result = ndli_remesh_rehearse(r->staged, bytes, size, error);
    if (result == SB_OK && !head.stale)
        result = ndli_remesh_pass(r->staged, bytes, size, 1, error);
    if (result != SB_OK) {
        ndli_remesh_give_up_part(r);
        return result;
    }
    r->staged->stale = head.stale;
    if (!head.stale)
        ndli_remesh_read(r->staged, body, bytes);
    return SB_OK;
}

NDLI_API const int *ndli_remesh_staged_nodes(const ndl_remesh *remesh, int needle, int *count)
{
    *count = remesh->staged->stale ? 0 : remesh->staged->needles[needle].count;
    return remesh->staged->needles[needle].nodes;
}

static void ndli_remesh_load_part(void *user, const unsigned char *bytes, size_t size)
{
    ndl_remesh *r = (ndl_remesh *)user, *staged = r->staged, old = *r;
    (void)bytes;
    (void)size;
    r->topology = staged->topology;
    r->needles = staged->needles;
    r->leaving = staged->leaving;
    r->leaving_capacity = staged->leaving_capacity;
    r->release_cursor = staged->release_cursor;
    r->stale = staged->stale;
    staged->topology = old.topology;
    staged->needles = old.needles;
    staged->leaving = old.leaving;
    ndli_remesh_give_up_part(r);
    ndli_topology_look(r->mesh, r->body);
}

/* ---- recording ---- */

NDLI_API void ndli_remesh_hush(ndl_remesh *r)
{
    if (r)
        sbi_body_mute(r->body);
}

NDLI_API void ndli_remesh_tell(ndl_remesh *r, const int *ints, size_t int_count, const sb_real *reals,
                               size_t real_count)
{
    int good = ints != NULL;
    sbi_body_unmute(r->body);
    for (size_t i = 0; i < real_count; i++)
        good &= sb_is_finite(reals[i]);
    if (good)
        sbi_body_tell_part(r->body, ndli_remesh_name, ints, int_count, reals, real_count);
}

NDLI_API void ndli_remesh_tell_puncture(ndl_remesh *r, int needle, const ndl_surface_hit *hit, sb_real slip,
                                        sb_result result)
{
    int ints[5];
    sb_real reals[5];
    if (!r)
        return;
    if (!hit) {
        ndli_remesh_tell(r, NULL, 0, NULL, 0);
        return;
    }
    ints[0] = NDLI_COMMAND_PUNCTURE, ints[1] = needle, ints[2] = (int)result, ints[3] = hit->tet, ints[4] = hit->face;
    reals[0] = hit->along, reals[1] = hit->X.x, reals[2] = hit->X.y, reals[3] = hit->X.z, reals[4] = slip;
    ndli_remesh_tell(r, ints, 5, reals, 5);
}

NDLI_API void ndli_remesh_tell_move(ndl_remesh *r, int needle, sb_vec3 X, int forward, sb_result result)
{
    int ints[3];
    sb_real reals[3];
    if (!r)
        return;
    ints[0] = forward ? NDLI_COMMAND_PENETRATE : NDLI_COMMAND_RETRACT, ints[1] = needle, ints[2] = (int)result;
    reals[0] = X.x, reals[1] = X.y, reals[2] = X.z;
    ndli_remesh_tell(r, ints, 3, reals, 3);
}

NDLI_API void ndli_remesh_tell_withdraw(ndl_remesh *r, int needle, sb_result result)
{
    int ints[3];
    if (!r)
        return;
    ints[0] = NDLI_COMMAND_WITHDRAW, ints[1] = needle, ints[2] = (int)result;
    ndli_remesh_tell(r, ints, 3, NULL, 0);
}

/* A recording cannot make a remesher, nor end one: it says so when it is played. */
static void ndli_remesh_tell_life(ndl_remesh *r, ndli_remesh_command command)
{
    int ints[3];
    ints[0] = (int)command, ints[1] = 0, ints[2] = SB_OK;
    sbi_body_tell_part(r->body, ndli_remesh_name, ints, 3, NULL, 0);
}

NDLI_API sb_result ndli_remesh_join(ndl_remesh *r, ndli_remesh_replay replay, sb_error *error)
{
    sbi_state_part part;
    sb_result result;
    memset(&part, 0, sizeof part);
    memcpy(part.name, ndli_remesh_name, sizeof ndli_remesh_name);
    part.version = NDLI_REMESH_VERSION;
    part.user = r;
    part.save = ndli_remesh_save_part;
    part.check = ndli_remesh_check_part;
    part.load = ndli_remesh_load_part;
    part.give_up = ndli_remesh_give_up_part;
    part.replay = replay;
    result = sbi_body_join(r->body, &part, error);
    r->joined = result == SB_OK;
    if (result == SB_ERROR_ARGUMENT)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the body has a remesher already");
    if (r->joined)
        ndli_remesh_tell_life(r, NDLI_COMMAND_MADE);
    return result;
}

NDLI_API void ndli_remesh_leave(ndl_remesh *r)
{
    if (!r->joined)
        return;
    ndli_remesh_tell_life(r, NDLI_COMMAND_GONE);
    sbi_body_leave(r->body, ndli_remesh_name);
    r->joined = 0;
}
