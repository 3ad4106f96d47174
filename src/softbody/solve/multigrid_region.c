/* multigrid_region: where the stiffness jumps, and which parts are stiff in one piece. */
#include "multigrid_level.h"

#include <stdlib.h>
#include <string.h>

/* Couplings below this share of the largest of either node are cut. Bodies whose moduli differ less need no regions:
 * six slabs of alternating stiffness take 6 iterations at 1:6 where an even body takes 4. */
#define SBI_REGION_CUT 0.2

enum { SBI_REGION_SEEDS = 8 }; /* triangles tried at a node: more than that are never in no solid piece */

/* Pieces in the making. A piece is what moves as one: it grows from a triangle by nodes that are held by three of its
 * nodes which are not in line, as the next tet across a face is. Pieces that share a node or an edge only can turn
 * about it like a hinge, so they are two; the shared nodes belong to the first, and linear motions of either pass
 * through them. */
typedef struct sbi_region_maker {
    const sb_matrix *pattern;
    const sb_real *moduli;
    const sb_vec3 *positions;
    sb_real *most; /* [rows] largest modulus of a node's couplings (Pa) */
    int *region;   /* [rows] -1: none yet */
    int *queue;    /* [rows] nodes of the piece at work */
    int *member;   /* [rows] number of the last piece with the node, */
    int *touched;  /* [rows] and of the last one that has a neighbour of it, */
    int *holders;  /* [rows][2] its first two neighbours there; the second may be -1 */
    int piece, region_count;
} sbi_region_maker;

static int sbi_region_is_strong(const sbi_region_maker *m, int i, int q)
{
    int j = m->pattern->columns[q];
    double most = (double)(m->most[i] > m->most[j] ? m->most[i] : m->most[j]);
    return j != i && (double)m->moduli[q] > SBI_REGION_CUT * most;
}

/* 1: three nodes lie within a tenth of their extent of one line. */
static int sbi_region_in_line(const sb_vec3 *x, int a, int b, int c)
{
    sb_vec3 u = sb_v3_sub(x[b], x[a]), v = sb_v3_sub(x[c], x[a]), w = sb_v3_sub(x[c], x[b]), n = sb_v3_cross(u, v);
    double uu = (double)sb_v3_dot(u, u), vv = (double)sb_v3_dot(v, v), ww = (double)sb_v3_dot(w, w);
    double longest = uu > vv ? uu : vv;
    longest = ww > longest ? ww : longest;
    return (double)sb_v3_dot(n, n) < 0.01 * longest * longest;
}

static void sbi_region_join(sbi_region_maker *m, int node, int *count)
{
    m->member[node] = m->piece;
    m->queue[(*count)++] = node;
}

/* A neighbour of node j has come into the piece: 1 when j is held now. */
static int sbi_region_hold(sbi_region_maker *m, int j, int by)
{
    int *holders = m->holders + 2 * (size_t)j;
    if (m->touched[j] != m->piece) {
        m->touched[j] = m->piece;
        holders[0] = by;
        holders[1] = -1;
    } else if (holders[1] < 0) {
        holders[1] = by;
    } else {
        return !sbi_region_in_line(m->positions, holders[0], holders[1], by);
    }
    return 0;
}

static int sbi_region_grow(sbi_region_maker *m, int count)
{
    const sb_matrix *a = m->pattern;
    for (int head = 0; head < count; head++) {
        int i = m->queue[head];
        for (int q = a->row_start[i]; q < a->row_end[i]; q++) {
            int j = a->columns[q];
            if (m->member[j] != m->piece && sbi_region_is_strong(m, i, q) && sbi_region_hold(m, j, i))
                sbi_region_join(m, j, &count);
        }
    }
    return count;
}

/* Starts a piece with the triangle of strong couplings at node i that comes after `skip` others; 0: there is none. */
static int sbi_region_seed(sbi_region_maker *m, int i, int skip)
{
    const sb_matrix *a = m->pattern;
    int count = 0;
    for (int q = a->row_start[i]; q < a->row_end[i]; q++) {
        int j = a->columns[q];
        if (!sbi_region_is_strong(m, i, q))
            continue;
        for (int p = q + 1; p < a->row_end[i]; p++) {
            int k = a->columns[p], side = sbi_region_is_strong(m, i, p) ? sb_matrix_find(a, j, k) : -1;
            if (side < 0 || !sbi_region_is_strong(m, j, side) || skip-- > 0)
                continue;
            m->piece++;
            sbi_region_join(m, i, &count);
            sbi_region_join(m, j, &count);
            sbi_region_join(m, k, &count);
            return count;
        }
    }
    return 0;
}

/* The region that owns three nodes of the piece which are not in line, and so moves with it; or -1. */
static int sbi_region_owner(const sbi_region_maker *m, int count)
{
    for (int k = 0; k < count; k++) {
        int region = m->region[m->queue[k]], second = -1;
        for (int l = k + 1; l < count && region >= 0; l++) {
            int node = m->queue[l];
            if (m->region[node] != region)
                continue;
            if (second < 0)
                second = node;
            else if (!sbi_region_in_line(m->positions, m->queue[k], second, node))
                return region;
        }
    }
    return -1;
}

/* Finds the piece that node i is in. */
static void sbi_region_place(sbi_region_maker *m, int i)
{
    for (int skip = 0; skip < SBI_REGION_SEEDS && m->region[i] < 0; skip++) {
        int count = sbi_region_seed(m, i, skip), owner;
        if (count == 0)
            return;
        count = sbi_region_grow(m, count);
        if (count < 4)
            continue;
        owner = sbi_region_owner(m, count);
        for (int k = 0; k < count; k++)
            if (m->region[m->queue[k]] < 0)
                m->region[m->queue[k]] = owner < 0 ? m->region_count : owner;
        m->region_count += owner < 0;
    }
}

/* Nodes in no piece go with the neighbour that they are coupled with most. */
static void sbi_region_place_rest(sbi_region_maker *m)
{
    const sb_matrix *a = m->pattern;
    int changed = 1;
    while (changed) {
        changed = 0;
        for (int i = 0; i < a->row_count; i++) {
            int best = -1;
            for (int q = a->row_start[i]; q < a->row_end[i] && m->region[i] < 0; q++)
                if (m->region[a->columns[q]] >= 0 && (best < 0 || m->moduli[q] > m->moduli[best]))
                    best = q;
            if (best < 0)
                continue;
            m->region[i] = m->region[a->columns[best]];
            changed = 1;
        }
    }
    for (int i = 0; i < a->row_count; i++) /* coupled with none that has a region */
        m->region[i] = m->region[i] < 0 ? 0 : m->region[i];
}

static void sbi_region_prepare(sbi_region_maker *m)
{
    const sb_matrix *a = m->pattern;
    m->queue = m->region + a->row_count;
    m->member = m->queue + a->row_count;
    m->touched = m->member + a->row_count;
    m->holders = m->touched + a->row_count;
    for (int i = 0; i < a->row_count; i++) {
        m->region[i] = -1;
        m->member[i] = m->touched[i] = 0;
        m->most[i] = 0;
        for (int q = a->row_start[i]; q < a->row_end[i]; q++)
            if (a->columns[q] != i && m->moduli[q] > m->most[i])
                m->most[i] = m->moduli[q];
    }
}

/* Hands the regions over. */
static int sbi_region_finish(const sbi_region_maker *m, const sb_allocator *allocator, sbi_mg_regions *regions)
{
    size_t n = (size_t)m->pattern->row_count, count = (size_t)m->region_count;
    if (m->region_count < 2)
        return 1;
    regions->of = (int *)sbi_alloc(allocator, n, sizeof(int));
    regions->moduli = (sb_real *)sbi_alloc_zeroed(allocator, count, sizeof(sb_real));
    regions->sizes = (int *)sbi_alloc_zeroed(allocator, count, sizeof(int));
    if (!regions->of || !regions->moduli || !regions->sizes) {
        sbi_mg_regions_free(allocator, regions);
        return 0;
    }
    regions->count = m->region_count;
    regions->row_count = m->pattern->row_count;
    memcpy(regions->of, m->region, n * sizeof(int));
    for (size_t i = 0; i < n; i++) {
        int r = m->region[i];
        regions->sizes[r]++;
        if (m->most[i] > regions->moduli[r])
            regions->moduli[r] = m->most[i];
    }
    return 1;
}

SBI_API void sbi_mg_regions_free(const sb_allocator *allocator, sbi_mg_regions *regions)
{
    sbi_free(allocator, regions->of);
    sbi_free(allocator, regions->moduli);
    sbi_free(allocator, regions->sizes);
    memset(regions, 0, sizeof *regions);
}

SBI_API int sbi_mg_find_regions(const sb_matrix *pattern, const sb_real *moduli, const sb_vec3 *positions,
                                const sb_allocator *allocator, sbi_mg_regions *regions)
{
    size_t n = (size_t)pattern->row_count;
    sbi_region_maker m;
    int made = 0;
    memset(&m, 0, sizeof m);
    memset(regions, 0, sizeof *regions);
    m.pattern = pattern;
    m.moduli = moduli;
    m.positions = positions;
    m.most = (sb_real *)sbi_alloc(allocator, n, sizeof(sb_real));
    m.region = (int *)sbi_alloc(allocator, n, 6 * sizeof(int));
    if (m.most && m.region) {
        sbi_region_prepare(&m);
        for (int i = 0; i < pattern->row_count; i++)
            if (m.region[i] < 0)
                sbi_region_place(&m, i);
        sbi_region_place_rest(&m);
        made = sbi_region_finish(&m, allocator, regions);
    }
    sbi_free(allocator, m.most);
    sbi_free(allocator, m.region);
    return made;
}

SBI_API int sbi_mg_copy_regions(const sbi_mg_regions *from, const sb_allocator *allocator, sbi_mg_regions *regions)
{
    size_t n = (size_t)from->row_count, count = (size_t)from->count;
    memset(regions, 0, sizeof *regions);
    if (from->count == 0)
        return 1;
    regions->of = (int *)sbi_alloc(allocator, n, sizeof(int));
    regions->moduli = (sb_real *)sbi_alloc(allocator, count, sizeof(sb_real));
    regions->sizes = (int *)sbi_alloc(allocator, count, sizeof(int));
    if (!regions->of || !regions->moduli || !regions->sizes) {
        sbi_mg_regions_free(allocator, regions);
        return 0;
    }
    regions->count = from->count;
    regions->row_count = from->row_count;
    memcpy(regions->of, from->of, n * sizeof(int));
    memcpy(regions->moduli, from->moduli, count * sizeof(sb_real));
    memcpy(regions->sizes, from->sizes, count * sizeof(int));
    return 1;
}

/* ---- few enough for a level ---------------------------------------------------------------------------- */

typedef struct sbi_region_rank {
    int size, region;
} sbi_region_rank;

static int sbi_region_compare(const void *a, const void *b)
{
    const sbi_region_rank *p = (const sbi_region_rank *)a, *q = (const sbi_region_rank *)b;
    if (p->size != q->size)
        return p->size > q->size ? -1 : 1;
    return p->region < q->region ? -1 : p->region > q->region;
}

/* Marks the regions of labels: 1 those to be kept, the `most` largest. Returns how many labels there are. */
static int sbi_region_rank_labels(const sbi_mg_regions *regions, const int *labels, int count, int most,
                                  sbi_region_rank *ranks, int *kept)
{
    int present = 0;
    memset(kept, 0, (size_t)regions->count * sizeof(int));
    for (int i = 0; i < count; i++) {
        if (!kept[labels[i]]) {
            ranks[present].size = regions->sizes[labels[i]];
            ranks[present++].region = labels[i];
        }
        kept[labels[i]] = 1;
    }
    qsort(ranks, (size_t)present, sizeof *ranks, sbi_region_compare);
    for (int k = most; k < present; k++)
        kept[ranks[k].region] = 0;
    return present;
}

SBI_API int sbi_mg_limit_regions(const sbi_mg_level *level, const sbi_mg_regions *regions, int most,
                                 const sb_allocator *allocator, int *labels)
{
    size_t count = (size_t)regions->count;
    sbi_region_rank *ranks = (sbi_region_rank *)sbi_alloc(allocator, count, sizeof *ranks);
    int *kept = (int *)sbi_alloc(allocator, count, 2 * sizeof(int)), *target, present;
    if (!ranks || !kept) {
        sbi_free(allocator, ranks);
        sbi_free(allocator, kept);
        return 0;
    }
    target = kept + count;
    present = sbi_region_rank_labels(regions, labels, level->row_count, most, ranks, kept);
    for (int r = 0; r < regions->count; r++)
        target[r] = kept[r] ? r : -1;
    for (int i = 0; i < level->row_count && present > most; i++)
        for (int q = level->row_start[i]; q < level->row_start[i + 1] && !kept[labels[i]]; q++) {
            int other = labels[level->columns[q]], *best = target + labels[i];
            if (kept[other] && (*best < 0 || regions->sizes[other] > regions->sizes[*best]))
                *best = other;
        }
    for (int i = 0; i < level->row_count; i++)
        labels[i] = target[labels[i]] < 0 ? ranks[0].region : target[labels[i]];
    sbi_free(allocator, ranks);
    sbi_free(allocator, kept);
    return 1;
}
