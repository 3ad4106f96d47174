/* kdtree: building by medians, and queries that walk down the nearer half first.
 *
 * The tree is complete: node i has the children 2i and 2i + 1, the leaves come last, and leaf j of L holds the points
 * from floor(n j / L) on. Distances and the bounds of boxes are sums of three squares in one order; each rounding is
 * monotone, so a bound never exceeds the distance of a point in the box, and nothing is lost to rounding. */
#include "kdtree.h"

#include <limits.h>

enum { REGI_KDTREE_LEAF = 8, REGI_KDTREE_STACK = 40 };

/* Boxes around the two children. */
typedef struct regi_kdtree_node {
    sb_real low[3][2], high[3][2];
} regi_kdtree_node;

typedef struct regi_kdtree_leaf {
    sb_real x[REGI_KDTREE_LEAF], y[REGI_KDTREE_LEAF], z[REGI_KDTREE_LEAF]; /* NaN where there is no point */
    int index[REGI_KDTREE_LEAF];
} regi_kdtree_leaf;

struct reg_kdtree {
    sb_allocator allocator;
    regi_kdtree_node *nodes; /* [leaf_count]; 0 is unused */
    regi_kdtree_leaf *leaves;
    int leaf_count; /* a power of 2 */
    int count;
};

/* ---- building ---------------------------------------------------------------------------------------------------- */

typedef struct regi_kdtree_point {
    sb_real x[3];
    int index;
} regi_kdtree_point;

static void regi_kdtree_swap(regi_kdtree_point *a, regi_kdtree_point *b)
{
    regi_kdtree_point t = *a;
    *a = *b;
    *b = t;
}

/* Hoare's selection: what belongs at `middle` gets there, smaller ones before it. The pivot is drawn, so that no
 * arrangement of the points is slow; scans stop at equal keys, so that many equal points are split evenly. */
static void regi_kdtree_select(regi_kdtree_point *p, int low, int high, int middle, int axis)
{
    uint32_t draw = 2463534242u;
    while (low < high) {
        int i = low, j = high;
        sb_real pivot;
        draw ^= draw << 13, draw ^= draw >> 17, draw ^= draw << 5;
        pivot = p[low + (int)(draw % (uint32_t)(high - low + 1))].x[axis];
        while (i <= j) {
            while (p[i].x[axis] < pivot)
                i++;
            while (pivot < p[j].x[axis])
                j--;
            if (i <= j)
                regi_kdtree_swap(p + i++, p + j--);
        }
        if (middle <= j)
            high = j;
        else if (middle >= i)
            low = i;
        else
            return;
    }
}

static int regi_kdtree_start(const reg_kdtree *tree, int leaf)
{
    return (int)((int64_t)tree->count * leaf / tree->leaf_count);
}

/* Fills leaf `leaf` with the points from..to. */
static void regi_kdtree_fill(reg_kdtree *tree, int leaf, const regi_kdtree_point *p, int from, int to)
{
    regi_kdtree_leaf *out = tree->leaves + leaf;
    for (int i = 0; i < REGI_KDTREE_LEAF; i++) {
        int there = from + i < to;
        out->x[i] = there ? p[from + i].x[0] : (sb_real)INFINITY;
        out->y[i] = there ? p[from + i].x[1] : (sb_real)INFINITY;
        out->z[i] = there ? p[from + i].x[2] : (sb_real)INFINITY;
        out->index[i] = there ? p[from + i].index : -1;
    }
}

/* Builds `node` over the leaves first .. first + leaves - 1, and notes its box with its parent. */
static void regi_kdtree_build(reg_kdtree *tree, regi_kdtree_point *p, int node, int first, int leaves)
{
    int from = regi_kdtree_start(tree, first), to = regi_kdtree_start(tree, first + leaves), widest = 0;
    sb_real low[3], high[3];
    for (int a = 0; a < 3; a++)
        low[a] = high[a] = p[from].x[a];
    for (int i = from + 1; i < to; i++)
        for (int a = 0; a < 3; a++) {
            low[a] = sb_min(low[a], p[i].x[a]);
            high[a] = sb_max(high[a], p[i].x[a]);
        }
    for (int a = 0; a < 3; a++) {
        if (high[a] - low[a] > high[widest] - low[widest])
            widest = a;
        if (node > 1) {
            tree->nodes[node / 2].low[a][node % 2] = low[a];
            tree->nodes[node / 2].high[a][node % 2] = high[a];
        }
    }
    if (leaves == 1) {
        regi_kdtree_fill(tree, first, p, from, to);
        return;
    }
    regi_kdtree_select(p, from, to - 1, regi_kdtree_start(tree, first + leaves / 2), widest);
    regi_kdtree_build(tree, p, 2 * node, first, leaves / 2);
    regi_kdtree_build(tree, p, 2 * node + 1, first + leaves / 2, leaves / 2);
}

static sb_result regi_kdtree_check(const sb_vec3 *points, int count, sb_error *error)
{
    sb_real most = sb_sqrt(SB_REAL_MAX) / 8;
    if (!points || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a tree needs at least one point, not %d", count);
    for (int i = 0; i < count; i++) {
        if (!sb_v3_is_finite(points[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "point %d has a coordinate that is not finite", i);
        if (sb_abs(points[i].x) > most || sb_abs(points[i].y) > most || sb_abs(points[i].z) > most)
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "point %d is too far from the origin to be squared", i);
    }
    return SB_OK;
}

static reg_kdtree *regi_kdtree_allocate(int count, const sb_allocator *allocator)
{
    reg_kdtree *tree = NULL;
    int leaf_count = 1;
    while ((int64_t)leaf_count * REGI_KDTREE_LEAF < count)
        leaf_count *= 2;
    for (sbi_arena arena = {NULL, 0, 0};;) {
        reg_kdtree *head = (reg_kdtree *)sbi_arena_take(&arena, 1, sizeof(reg_kdtree));
        regi_kdtree_node *nodes = (regi_kdtree_node *)sbi_arena_take(&arena, (size_t)leaf_count, sizeof *nodes);
        regi_kdtree_leaf *leaves = (regi_kdtree_leaf *)sbi_arena_take(&arena, (size_t)leaf_count, sizeof *leaves);
        if (arena.base) {
            tree = head;
            tree->nodes = nodes;
            tree->leaves = leaves;
            tree->leaf_count = leaf_count;
            tree->count = count;
            memset(&tree->allocator, 0, sizeof tree->allocator);
            if (allocator)
                tree->allocator = *allocator;
            return tree;
        }
        arena.base = arena.overflow ? NULL : (unsigned char *)sbi_alloc(allocator, 1, arena.used);
        arena.used = 0;
        if (!arena.base)
            return NULL;
    }
}

REG_API sb_result reg_kdtree_create(const sb_vec3 *points, int count, const sb_allocator *allocator, reg_kdtree **tree,
                                    sb_error *error)
{
    sb_result result = regi_kdtree_check(points, count, error);
    regi_kdtree_point *scratch;
    reg_kdtree *made;
    if (result != SB_OK)
        return result;
    if (!tree)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "nowhere to put the tree");
    made = regi_kdtree_allocate(count, allocator);
    scratch = made ? (regi_kdtree_point *)sbi_alloc(allocator, (size_t)count, sizeof *scratch) : NULL;
    if (!scratch) {
        reg_kdtree_destroy(made);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a tree of %d points", count);
    }
    for (int i = 0; i < count; i++) {
        scratch[i].x[0] = points[i].x;
        scratch[i].x[1] = points[i].y;
        scratch[i].x[2] = points[i].z;
        scratch[i].index = i;
    }
    regi_kdtree_build(made, scratch, 1, 0, made->leaf_count);
    sbi_free(allocator, scratch);
    *tree = made;
    return SB_OK;
}

REG_API void reg_kdtree_destroy(reg_kdtree *tree)
{
    if (tree) {
        sb_allocator allocator = tree->allocator;
        sbi_free(&allocator, tree);
    }
}

REGI_API void regi_kdtree_order(const reg_kdtree *tree, int *order)
{
    for (int leaf = 0, n = 0; leaf < tree->leaf_count; leaf++)
        for (int i = 0; i < REGI_KDTREE_LEAF && tree->leaves[leaf].index[i] >= 0; i++)
            order[n++] = tree->leaves[leaf].index[i];
}

REG_API int reg_kdtree_count(const reg_kdtree *tree) { return tree ? tree->count : 0; }

/* ---- queries ----------------------------------------------------------------------------------------------------- */

/* Squared distances to the boxes of the two children. */
static void regi_kdtree_bounds(const regi_kdtree_node *node, sb_vec3 p, sb_real bound[2])
{
    sb_real gap[3][2];
    for (int c = 0; c < 2; c++) {
        gap[0][c] = sb_max(sb_max(node->low[0][c] - p.x, p.x - node->high[0][c]), 0);
        gap[1][c] = sb_max(sb_max(node->low[1][c] - p.y, p.y - node->high[1][c]), 0);
        gap[2][c] = sb_max(sb_max(node->low[2][c] - p.z, p.z - node->high[2][c]), 0);
    }
    for (int c = 0; c < 2; c++)
        bound[c] = gap[0][c] * gap[0][c] + gap[1][c] * gap[1][c] + gap[2][c] * gap[2][c];
}

/* Squared distances to the points of a leaf; infinity, which is beyond every limit, where there is none. (A NaN would
 * raise the invalid exception in each comparison.) */
static void regi_kdtree_distances(const regi_kdtree_leaf *leaf, sb_vec3 p, sb_real d[REGI_KDTREE_LEAF])
{
    for (int i = 0; i < REGI_KDTREE_LEAF; i++) {
        sb_real x = leaf->x[i] - p.x, y = leaf->y[i] - p.y, z = leaf->z[i] - p.z;
        d[i] = x * x + y * y + z * z;
    }
}

/* What is left to visit. */
typedef struct regi_kdtree_walk {
    sb_real bound[REGI_KDTREE_STACK];
    int node[REGI_KDTREE_STACK];
    int depth;
} regi_kdtree_walk;

static void regi_kdtree_begin(regi_kdtree_walk *walk)
{
    walk->bound[0] = 0;
    walk->node[0] = 1;
    walk->depth = 1;
}

/* The next leaf whose box is at most sqrt(limit) away, nearer ones first, or NULL. */
static const regi_kdtree_leaf *regi_kdtree_next(const reg_kdtree *tree, regi_kdtree_walk *walk, sb_vec3 p,
                                                sb_real limit)
{
    while (walk->depth > 0) {
        int node = walk->node[--walk->depth];
        sb_real bound[2];
        if (walk->bound[walk->depth] > limit)
            continue;
        while (node < tree->leaf_count) {
            int nearer;
            regi_kdtree_bounds(tree->nodes + node, p, bound);
            nearer = bound[1] < bound[0];
            if (bound[!nearer] <= limit) {
                walk->bound[walk->depth] = bound[!nearer];
                walk->node[walk->depth++] = 2 * node + !nearer;
            }
            if (!(bound[nearer] <= limit))
                break;
            node = 2 * node + nearer;
        }
        if (node >= tree->leaf_count)
            return tree->leaves + (node - tree->leaf_count);
    }
    return NULL;
}

/* Square of a radius, or -1 for one that no point can be within; never infinite, so that points too far off to be
 * squared are no answer. */
static sb_real regi_kdtree_limit(sb_real within)
{
    if (!(within >= 0))
        return -1;
    return sbi_capped_product(within, within);
}

REGI_API int regi_kdtree_nearest_from(const reg_kdtree *tree, sb_vec3 point, int found, sb_real *squared)
{
    sb_real best = *squared, d[REGI_KDTREE_LEAF];
    const regi_kdtree_leaf *leaf;
    regi_kdtree_walk walk;
    regi_kdtree_begin(&walk);
    while ((leaf = regi_kdtree_next(tree, &walk, point, best)) != NULL) {
        regi_kdtree_distances(leaf, point, d);
        for (int i = 0; i < REGI_KDTREE_LEAF; i++)
            if (d[i] <= best && (d[i] < best || leaf->index[i] < found)) {
                best = d[i];
                found = leaf->index[i];
            }
    }
    *squared = best;
    return found;
}

REG_API int reg_kdtree_nearest(const reg_kdtree *tree, sb_vec3 point, sb_real within, sb_real *squared)
{
    sb_real best = regi_kdtree_limit(within);
    int found;
    if (!tree || best < 0 || !sb_v3_is_finite(point))
        return -1;
    found = regi_kdtree_nearest_from(tree, point, INT_MAX, &best);
    if (found == INT_MAX)
        return -1;
    if (squared)
        *squared = best;
    return found;
}

static int regi_kdtree_farther(const int *indices, const sb_real *squared, int a, int b)
{
    return squared[a] > squared[b] || (squared[a] == squared[b] && indices[a] > indices[b]);
}

static void regi_kdtree_exchange(int *indices, sb_real *squared, int a, int b)
{
    int index = indices[a];
    sb_real d = squared[a];
    indices[a] = indices[b], indices[b] = index;
    squared[a] = squared[b], squared[b] = d;
}

/* Restores a heap with the farthest on top after entry `at` has become nearer. */
static void regi_kdtree_sink(int *indices, sb_real *squared, int count, int at)
{
    for (;;) {
        int child = 2 * at + 1;
        if (child >= count)
            return;
        if (child + 1 < count && regi_kdtree_farther(indices, squared, child + 1, child))
            child++;
        if (!regi_kdtree_farther(indices, squared, child, at))
            return;
        regi_kdtree_exchange(indices, squared, at, child);
        at = child;
    }
}

static void regi_kdtree_rise(int *indices, sb_real *squared, int at)
{
    for (; at > 0 && regi_kdtree_farther(indices, squared, at, (at - 1) / 2); at = (at - 1) / 2)
        regi_kdtree_exchange(indices, squared, at, (at - 1) / 2);
}

REG_API int reg_kdtree_k_nearest(const reg_kdtree *tree, sb_vec3 point, int k, int *indices, sb_real *squared)
{
    sb_real limit = SB_REAL_MAX, d[REGI_KDTREE_LEAF];
    const regi_kdtree_leaf *leaf;
    regi_kdtree_walk walk;
    int count = 0;
    if (!tree || k < 1 || !indices || !squared || !sb_v3_is_finite(point))
        return 0;
    regi_kdtree_begin(&walk);
    while ((leaf = regi_kdtree_next(tree, &walk, point, limit)) != NULL) {
        regi_kdtree_distances(leaf, point, d);
        for (int i = 0; i < REGI_KDTREE_LEAF; i++) {
            if (!(d[i] <= limit) || (count == k && d[i] == limit && leaf->index[i] > indices[0]))
                continue;
            if (count < k) {
                indices[count] = leaf->index[i];
                squared[count] = d[i];
                regi_kdtree_rise(indices, squared, count++);
            } else {
                indices[0] = leaf->index[i];
                squared[0] = d[i];
                regi_kdtree_sink(indices, squared, count, 0);
            }
            if (count == k)
                limit = squared[0];
        }
    }
    for (int last = count - 1; last > 0; last--) {
        regi_kdtree_exchange(indices, squared, 0, last);
        regi_kdtree_sink(indices, squared, last, 0);
    }
    return count;
}

REG_API int reg_kdtree_within(const reg_kdtree *tree, sb_vec3 point, sb_real radius, int *indices, int room)
{
    sb_real limit = regi_kdtree_limit(radius), d[REGI_KDTREE_LEAF];
    const regi_kdtree_leaf *leaf;
    regi_kdtree_walk walk;
    int count = 0;
    if (!tree || limit < 0 || !sb_v3_is_finite(point))
        return 0;
    regi_kdtree_begin(&walk);
    while ((leaf = regi_kdtree_next(tree, &walk, point, limit)) != NULL) {
        regi_kdtree_distances(leaf, point, d);
        for (int i = 0; i < REGI_KDTREE_LEAF; i++)
            if (d[i] <= limit) {
                if (indices && count < room)
                    indices[count] = leaf->index[i];
                count++;
            }
    }
    return count;
}
