/* patch: disjoint patches of tets, over each of which the change of volume is averaged. */
#include "patch.h"

#include <string.h>

typedef struct sbi_patcher {
    const sb_mesh *mesh;
    const int *neighbours; /* [cells][4], -1: none */
    int *patch;            /* [cells] or -1 */
    int *size;             /* [patches] */
    int *next, *previous;  /* [cells + 5] rings of free cells by their number of free neighbours; the last five are
                            * their heads */
    unsigned char *open;   /* [cells] free neighbours */
    int count;
} sbi_patcher;

static int sbi_patch_region(const sb_mesh *mesh, int e) { return mesh->regions ? mesh->regions[e] : 0; }

/* The neighbour of the same region across a face, or -1. */
static int sbi_patch_beside(const sbi_patcher *p, int e, int face)
{
    int other = p->neighbours[4 * (size_t)e + (size_t)face];
    return other >= 0 && sbi_patch_region(p->mesh, other) == sbi_patch_region(p->mesh, e) ? other : -1;
}

/* ---- cells that a generator has cut ---- */

static int sbi_patch_has_node(const int *nodes, int count, int node)
{
    for (int k = 0; k < count; k++)
        if (nodes[k] == node)
            return 1;
    return 0;
}

/* 1 when `size` tets from `first` on are of one region and have the eight nodes of a hexahedron between them, each but
 * the first a face with those before it or, of five, with the last. */
static int sbi_patch_is_cell(const sbi_patcher *p, int first, int size)
{
    int nodes[8], count = 0, faces = 0;
    for (int e = first; e < first + size; e++) {
        for (int a = 0; a < 4; a++) {
            int node = p->mesh->elements[4 * (size_t)e + (size_t)a];
            if (sbi_patch_has_node(nodes, count, node))
                continue;
            if (count == 8)
                return 0;
            nodes[count++] = node;
        }
        for (int f = 0; f < 4; f++) {
            int other = sbi_patch_beside(p, e, f);
            faces += other >= first && other < first + size;
        }
        if (sbi_patch_region(p->mesh, e) != sbi_patch_region(p->mesh, first))
            return 0;
    }
    return count == 8 && faces >= 2 * (size - 1); /* a tree at least, each face seen from both sides */
}

/* Patches that are cells of so many tets; 0 where some are none. */
static int sbi_patch_take_cells(sbi_patcher *p, int size)
{
    int cells = p->mesh->element_count;
    if (cells % size != 0)
        return 0;
    for (int e = 0; e < cells; e += size)
        if (!sbi_patch_is_cell(p, e, size))
            return 0;
    for (int e = 0; e < cells; e++)
        p->patch[e] = e / size;
    p->count = cells / size;
    return 1;
}

/* ---- growth ---- */

static void sbi_patch_unlink(sbi_patcher *p, int e)
{
    p->next[p->previous[e]] = p->next[e];
    p->previous[p->next[e]] = p->previous[e];
}

/* To the head of its ring. */
static void sbi_patch_link(sbi_patcher *p, int e)
{
    int head = p->mesh->element_count + p->open[e];
    p->next[e] = p->next[head];
    p->previous[e] = head;
    p->previous[p->next[e]] = e;
    p->next[head] = e;
}

static void sbi_patch_link_all(sbi_patcher *p)
{
    int cells = p->mesh->element_count;
    for (int head = cells; head < cells + 5; head++)
        p->next[head] = p->previous[head] = head;
    for (int e = cells - 1; e >= 0; e--) {
        p->open[e] = 0;
        for (int f = 0; f < 4; f++)
            p->open[e] = (unsigned char)(p->open[e] + (sbi_patch_beside(p, e, f) >= 0));
        sbi_patch_link(p, e);
    }
}

static void sbi_patch_take(sbi_patcher *p, int e, int patch)
{
    sbi_patch_unlink(p, e);
    p->patch[e] = patch;
    p->size[patch]++;
    for (int f = 0; f < 4; f++) {
        int other = sbi_patch_beside(p, e, f);
        if (other < 0 || p->patch[other] >= 0)
            continue;
        sbi_patch_unlink(p, other);
        p->open[other]--;
        sbi_patch_link(p, other);
    }
}

/* The free cell with the fewest free neighbours, -1: none. */
static int sbi_patch_seed(const sbi_patcher *p)
{
    int cells = p->mesh->element_count;
    for (int head = cells; head < cells + 5; head++)
        if (p->next[head] != head)
            return p->next[head];
    return -1;
}

/* How much a cell belongs to a patch: nodes in it first, then faces, then how few others want it. */
static int sbi_patch_score(const sbi_patcher *p, const int *members, int count, int e)
{
    int nodes = 0, faces = 0;
    for (int a = 0; a < 4; a++)
        for (int k = 0; k < count; k++)
            if (sbi_patch_has_node(p->mesh->elements + 4 * (size_t)members[k], 4,
                                   p->mesh->elements[4 * (size_t)e + (size_t)a])) {
                nodes++;
                break;
            }
    for (int f = 0; f < 4; f++)
        faces += sbi_patch_has_node(members, count, sbi_patch_beside(p, e, f));
    return 25 * nodes + 5 * faces + 4 - p->open[e];
}

static void sbi_patch_grow(sbi_patcher *p, int seed)
{
    int members[SBI_PATCH_CELLS], count = 0, best = seed, patch = p->count++;
    p->size[patch] = 0;
    while (best >= 0) {
        int most = -1;
        sbi_patch_take(p, best, patch);
        members[count++] = best;
        best = -1;
        if (count == SBI_PATCH_CELLS)
            return;
        for (int k = 0; k < count; k++)
            for (int f = 0; f < 4; f++) {
                int e = sbi_patch_beside(p, members[k], f);
                int score = e >= 0 && p->patch[e] < 0 ? sbi_patch_score(p, members, count, e) : -1;
                if (score > most || (score == most && score >= 0 && e < best)) {
                    most = score;
                    best = e;
                }
            }
    }
}

/* ---- leftovers ---- */

/* The smallest other patch with a face of the cell and less than `most` cells, -1: none. */
static int sbi_patch_smallest_beside(const sbi_patcher *p, int e, int most)
{
    int best = -1;
    for (int f = 0; f < 4; f++) {
        int other = sbi_patch_beside(p, e, f), patch = other >= 0 ? p->patch[other] : -1;
        if (patch >= 0 && patch != p->patch[e] && p->size[patch] < most &&
            (best < 0 || p->size[patch] < p->size[best] || (p->size[patch] == p->size[best] && patch < best)))
            best = patch;
    }
    return best;
}

static void sbi_patch_move(sbi_patcher *p, int e, int patch)
{
    p->size[p->patch[e]]--;
    p->size[patch]++;
    p->patch[e] = patch;
}

/* Cells of a small patch, one by one, to those beside it, which stay below `most`; back again where one finds no place.
 * Returns 1 when none is left. */
static int sbi_patch_dissolve(sbi_patcher *p, const int *cells, int count, int most)
{
    int home = p->patch[cells[0]], moved = 1;
    while (moved && p->size[home] > 0) {
        moved = 0;
        for (int k = 0; k < count; k++) {
            int to = p->patch[cells[k]] == home ? sbi_patch_smallest_beside(p, cells[k], most) : -1;
            if (to < 0)
                continue;
            sbi_patch_move(p, cells[k], to);
            moved = 1;
        }
    }
    for (int k = 0; k < count && p->size[home] > 0; k++)
        if (p->patch[cells[k]] != home)
            sbi_patch_move(p, cells[k], home);
    return p->size[home] == 0;
}

/* 1 when the rest of a cell's patch stays connected without it. */
static int sbi_patch_may_lose(const sbi_patcher *p, int e)
{
    int reached[2 * SBI_PATCH_MOST], count = 0, patch = p->patch[e];
    if (p->size[patch] <= SBI_PATCH_LEAST || p->size[patch] > 2 * SBI_PATCH_MOST)
        return 0;
    for (int f = 0; f < 4 && count == 0; f++) {
        int other = sbi_patch_beside(p, e, f);
        if (other >= 0 && p->patch[other] == patch)
            reached[count++] = other;
    }
    for (int k = 0; k < count; k++)
        for (int f = 0; f < 4; f++) {
            int other = sbi_patch_beside(p, reached[k], f);
            if (other >= 0 && other != e && p->patch[other] == patch && !sbi_patch_has_node(reached, count, other))
                reached[count++] = other;
        }
    return count == p->size[patch] - 1;
}

/* A small patch takes cells from those beside it that can spare them, from the largest first. Returns its cells. */
static int sbi_patch_steal(sbi_patcher *p, int *cells, int count)
{
    int home = p->patch[cells[0]];
    while (count < SBI_PATCH_LEAST) {
        int best = -1;
        for (int k = 0; k < count; k++)
            for (int f = 0; f < 4; f++) {
                int e = sbi_patch_beside(p, cells[k], f);
                if (e >= 0 && p->patch[e] != home && sbi_patch_may_lose(p, e) &&
                    (best < 0 || p->size[p->patch[e]] > p->size[p->patch[best]]))
                    best = e;
            }
        if (best < 0)
            break;
        sbi_patch_move(p, best, home);
        cells[count++] = best;
    }
    return count;
}

/* The cells of a small patch, from one of them on; returns how many. */
static int sbi_patch_members(const sbi_patcher *p, int first, int *cells)
{
    int count = 0;
    cells[count++] = first;
    for (int k = 0; k < count; k++)
        for (int f = 0; f < 4; f++) {
            int other = sbi_patch_beside(p, cells[k], f);
            if (other >= 0 && p->patch[other] == p->patch[first] && !sbi_patch_has_node(cells, count, other))
                cells[count++] = other;
        }
    return count;
}

/* Patches with too few cells find room beside them, or cells, or else patches that grow beyond the most. */
static void sbi_patch_settle(sbi_patcher *p)
{
    for (int e = 0; e < p->mesh->element_count; e++) {
        int cells[SBI_PATCH_LEAST], count;
        if (p->size[p->patch[e]] >= SBI_PATCH_LEAST)
            continue;
        count = sbi_patch_members(p, e, cells);
        if (!sbi_patch_dissolve(p, cells, count, SBI_PATCH_MOST) && sbi_patch_steal(p, cells, count) < SBI_PATCH_LEAST)
            (void)sbi_patch_dissolve(p, cells, p->size[p->patch[e]], p->mesh->element_count);
    }
}

/* Numbers by the first cell, without those that are empty. */
static void sbi_patch_number(sbi_patcher *p)
{
    int *number = p->size, count = 0;
    for (int k = 0; k < p->count; k++)
        number[k] = -1;
    for (int e = 0; e < p->mesh->element_count; e++) {
        int patch = p->patch[e];
        if (number[patch] < 0)
            number[patch] = count++;
        p->patch[e] = number[patch];
    }
    p->count = count;
}

/* ---- entry points ---- */

static void sbi_patch_grow_all(sbi_patcher *p)
{
    for (int e = 0; e < p->mesh->element_count; e++)
        p->patch[e] = -1;
    sbi_patch_link_all(p);
    for (int seed = sbi_patch_seed(p); seed >= 0; seed = sbi_patch_seed(p))
        sbi_patch_grow(p, seed);
    sbi_patch_settle(p);
    sbi_patch_number(p);
}

/* Tets of one patch that are connected by faces get a number; `next` has the patches of before, `previous` is a stack.
 */
static void sbi_patch_part(sbi_patcher *p)
{
    const int *old = p->next;
    int *stack = p->previous, cells = p->mesh->element_count;
    memcpy(p->next, p->patch, (size_t)cells * sizeof(int));
    for (int e = 0; e < cells; e++)
        p->patch[e] = -1;
    for (int first = 0; first < cells; first++) {
        int top = 0;
        if (p->patch[first] >= 0)
            continue;
        p->size[p->count] = 0;
        stack[top++] = first;
        p->patch[first] = p->count;
        while (top > 0) {
            int e = stack[--top];
            p->size[p->count]++;
            for (int f = 0; f < 4; f++) {
                int other = sbi_patch_beside(p, e, f);
                if (other < 0 || old[e] < 0 || old[other] != old[e] || p->patch[other] >= 0)
                    continue;
                p->patch[other] = p->count;
                stack[top++] = other;
            }
        }
        p->count++;
    }
}

/* What both below need; SB_ERROR_MEMORY. sbi_patcher_free in any case. */
static sb_result sbi_patcher_begin(sbi_patcher *p, sb_index_table *neighbours, const sb_mesh *mesh,
                                   const sb_allocator *allocator, sb_error *error)
{
    size_t cells = (size_t)mesh->element_count;
    sb_result result;
    memset(p, 0, sizeof *p);
    memset(neighbours, 0, sizeof *neighbours);
    result = sb_mesh_neighbours(mesh, allocator, neighbours, error);
    if (result != SB_OK)
        return result;
    p->mesh = mesh;
    p->neighbours = neighbours->items;
    p->size = (int *)sbi_alloc(allocator, cells, sizeof(int));
    p->next = (int *)sbi_alloc(allocator, cells + 5, sizeof(int));
    p->previous = (int *)sbi_alloc(allocator, cells + 5, sizeof(int));
    p->open = (unsigned char *)sbi_alloc(allocator, cells, 1);
    if (p->size && p->next && p->previous && p->open)
        return SB_OK;
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the patches of %d elements", mesh->element_count);
}

static void sbi_patcher_end(sbi_patcher *p, sb_index_table *neighbours, const sb_allocator *allocator)
{
    sbi_free(allocator, p->size);
    sbi_free(allocator, p->next);
    sbi_free(allocator, p->previous);
    sbi_free(allocator, p->open);
    sb_index_table_free(neighbours);
}

SBI_API sb_result sbi_patch_make(const sb_mesh *mesh, const sb_allocator *allocator, int **patches, int *count,
                                 sb_error *error)
{
    sb_index_table neighbours;
    sbi_patcher p;
    sb_result result = sbi_patcher_begin(&p, &neighbours, mesh, allocator, error);
    if (result == SB_OK) {
        p.patch = (int *)sbi_alloc(allocator, (size_t)mesh->element_count, sizeof(int));
        if (!p.patch)
            result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the patches of %d elements", mesh->element_count);
    }
    if (result == SB_OK) {
        if (!sbi_patch_take_cells(&p, 6) && !sbi_patch_take_cells(&p, 5))
            sbi_patch_grow_all(&p);
        *patches = p.patch;
        *count = p.count;
    }
    sbi_patcher_end(&p, &neighbours, allocator);
    return result;
}

SBI_API sb_result sbi_patch_follow(const sb_mesh *mesh, const sb_allocator *allocator, int *patches, int *count,
                                   sb_error *error)
{
    sb_index_table neighbours;
    sbi_patcher p;
    sb_result result = sbi_patcher_begin(&p, &neighbours, mesh, allocator, error);
    if (result == SB_OK) {
        p.patch = patches;
        sbi_patch_part(&p);
        sbi_patch_settle(&p);
        sbi_patch_number(&p);
        *count = p.count;
    }
    sbi_patcher_end(&p, &neighbours, allocator);
    return result;
}
