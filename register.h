/* register.h 0.3.0: matching an organ model to what the surgeon sees
 * MIT or public domain, as you like; the texts are at the end of this file.
 * Generated from src/register/: edit there, then run `make headers`. */
#include "softbody.h"

/* ==== src/register/register_doc.h ==== */
/*
 * register.h - matching an organ model to what the surgeon sees, in one header on top of softbody.h.
 *
 * HOW TO INCLUDE
 *
 * In one C or C++ file, which is the one that holds softbody.h's implementation:
 *
 *     #define SB_IMPLEMENTATION
 *     #define REG_IMPLEMENTATION
 *     #include "register.h"
 *
 * and in all others only the last line; it includes softbody.h. Both headers come from one release and lie in one
 * folder. Link with -lm, optimise (-O2 or -O3).
 *
 * OPTIONS are softbody.h's. SB_REAL: exported names of a float build end in _f32. SB_STATIC makes this header static,
 * too; REG_STATIC makes only this one so.
 *
 * LICENCE
 *
 * MIT or public domain, as you like; the texts are at the end of this file.
 */

/* ==== src/register/../softbody/begin.h ==== */
/* begin: compiler settings for the library's own code; end.h gives the caller's back.
 *
 * A product and a sum may not be contracted into one rounding (fused multiply-add), or results would depend on the
 * compiler and the processor. Compilers differ in how a header can say so:
 * - clang: by the standard pragma; -ffp-contract=fast overrules it.
 * - gcc knows the standard pragma in no release yet, and contracts unless told -std=c99 or -ffp-contract=off. Its
 *   own pragma stops that, but code under it is not inlined into code outside, so it stands only where the target
 *   has fused instructions and the language mode lets gcc use them. The system headers come first: their inline
 *   functions are the caller's business.
 * - MSVC: by its own pragma, in the file that holds the implementation. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#if !defined(__STRICT_ANSI__) && (defined(__FP_FAST_FMA) || defined(__FP_FAST_FMAF))
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#if defined(SB_IMPLEMENTATION)
#include <errno.h>
#include <float.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#endif
#pragma GCC push_options
#pragma GCC optimize("fp-contract=off")
#endif
#elif defined(_MSC_VER) && defined(SB_IMPLEMENTATION)
#pragma fp_contract(off)
#endif

#ifndef REGISTER_H
#define REGISTER_H

/* ==== src/register/names.h ==== */
/* names: the exported names of a float build end in _f32, so that a float caller and a double object do
 * not link. Written by src/amalgamate.c from the declarations: do not edit. */
#ifndef REGI_NAMES_H
#define REGI_NAMES_H

#if defined(SB_REAL)
#define REGI_NAMES_PASTE_(a, b) a##b
#define REGI_NAMES_PASTE(a, b) REGI_NAMES_PASTE_(a, b)
#define REGI_NAMES_OF_double 0
#define REGI_NAMES_OF_float 1
#if REGI_NAMES_PASTE(REGI_NAMES_OF_, SB_REAL)
#define reg_rigid_identity reg_rigid_identity_f32
#define reg_rigid_apply reg_rigid_apply_f32
#define reg_rigid_compose reg_rigid_compose_f32
#define reg_rigid_inverse reg_rigid_inverse_f32
#define reg_rigid_angle reg_rigid_angle_f32
#define reg_rigid_fit reg_rigid_fit_f32
#define reg_kdtree_create reg_kdtree_create_f32
#define reg_kdtree_destroy reg_kdtree_destroy_f32
#define reg_kdtree_count reg_kdtree_count_f32
#define reg_kdtree_nearest reg_kdtree_nearest_f32
#define reg_kdtree_k_nearest reg_kdtree_k_nearest_f32
#define reg_kdtree_within reg_kdtree_within_f32
#endif
#endif

#endif /* REGI_NAMES_H */

/* ==== src/register/api.h ==== */
/* api: version and linkage of register.h. Results, errors, allocator, vectors and the scalar type are softbody.h's. */
#ifndef REG_API_H
#define REG_API_H


#define REG_VERSION_MAJOR 0
#define REG_VERSION_MINOR 3
#define REG_VERSION_PATCH 0
#define REG_VERSION_STRING "0.3.0"

#if REG_VERSION_MAJOR != SB_VERSION_MAJOR || REG_VERSION_MINOR != SB_VERSION_MINOR || \
    REG_VERSION_PATCH != SB_VERSION_PATCH
#error "register.h and softbody.h are of different versions: take both from one release"
#endif
#if defined(REG_IMPLEMENTATION) && !defined(SB_IMPLEMENTATION)
#error "register.h: define REG_IMPLEMENTATION in the file that defines SB_IMPLEMENTATION"
#endif

/* REG_API: public functions; static under SB_STATIC or REG_STATIC. REGI_API: internal functions; static in the shipped
 * header, extern when the rooms are compiled apart. */
#if defined(SB_STATIC) || defined(REG_STATIC)
#define REG_API static SBI_UNUSED
#elif defined(__cplusplus)
#define REG_API extern "C"
#else
#define REG_API extern
#endif
#if defined(SB_SPLIT_BUILD)
#define REGI_API extern
#else
#define REGI_API static SBI_UNUSED
#endif

#endif /* REG_API_H */

/* ==== src/register/rigid.h ==== */
/* rigid: rigid motions, and the one that brings points nearest to their partners. Floor 1. */
#ifndef REG_RIGID_H
#define REG_RIGID_H


/* x -> rotation x + translation. */
typedef struct reg_rigid {
    sb_mat3 rotation;    /* orthonormal, determinant 1 */
    sb_vec3 translation; /* m */
} reg_rigid;

REG_API reg_rigid reg_rigid_identity(void);
REG_API sb_vec3 reg_rigid_apply(const reg_rigid *motion, sb_vec3 point);
/* First `first`, then `then`. */
REG_API reg_rigid reg_rigid_compose(const reg_rigid *then, const reg_rigid *first);
REG_API reg_rigid reg_rigid_inverse(const reg_rigid *motion);
/* Angle (rad, in [0, pi]) of the rotation. */
REG_API sb_real reg_rigid_angle(const reg_rigid *motion);

/* The motion that minimises sum w |motion(from) - to|^2 (Kabsch 1976, never a reflection).
 * from, to: [count] partners (m); weights: [count] >= 0, not all 0, or NULL: all 1; count >= 1. Where the points leave
 * the rotation open (all in one line or one point) it is one of the best. SB_ERROR_ARGUMENT, _NOT_FINITE (index named)
 * leave *motion untouched. No allocation. */
REG_API sb_result reg_rigid_fit(const sb_vec3 *from, const sb_vec3 *to, const sb_real *weights, int count,
                                reg_rigid *motion, sb_error *error);

#endif /* REG_RIGID_H */

/* ==== src/register/kdtree.h ==== */
/* kdtree: nearest points of a cloud. Floor 2.
 *
 * A balanced tree over a copy of the points, eight to a leaf and side by side there; every node knows the smallest
 * boxes around its halves. Queries allocate and change nothing, so any number of threads may ask at once, and give the
 * same answer whatever the tree looks like: of points equally far, the one with the smallest index counts as nearer. */
#ifndef REG_KDTREE_H
#define REG_KDTREE_H


typedef struct reg_kdtree reg_kdtree;

/* Makes a tree of points[count] (m; count >= 1, points may coincide), which are copied. One block of memory from
 * `allocator` (NULL: malloc; at most 80 bytes per point) and scratch that goes back.
 * O(count log count). SB_ERROR_ARGUMENT (null pointer, no points, or a coordinate whose square would overflow),
 * _NOT_FINITE (error->node: the point), _MEMORY; then *tree is untouched. */
REG_API sb_result reg_kdtree_create(const sb_vec3 *points, int count, const sb_allocator *allocator, reg_kdtree **tree,
                                    sb_error *error);
REG_API void reg_kdtree_destroy(reg_kdtree *tree); /* accepts NULL */
/* Number of its points; 0 for NULL. */
REG_API int reg_kdtree_count(const reg_kdtree *tree);

/* Index of the point nearest to `point` among those at most `within` (m; SB_REAL_MAX: any) away, and its squared
 * distance (m^2) in *squared (may be NULL). -1 (nothing written) when there is none, the tree is NULL, or an argument
 * is not finite or negative. O(log count) for points near the cloud. */
REG_API int reg_kdtree_nearest(const reg_kdtree *tree, sb_vec3 point, sb_real within, sb_real *squared);

/* The k nearest points, nearest first: indices[k] and squared distances squared[k] (m^2; both needed). Returns how many
 * were found: k, or all points when there are fewer; 0 for k < 1, NULL, or a point that is not finite. */
REG_API int reg_kdtree_k_nearest(const reg_kdtree *tree, sb_vec3 point, int k, int *indices, sb_real *squared);

/* All points at most `radius` (m) away: returns how many, of which the first `room` are written to indices[room] (may
 * be NULL with room 0: only count). In no particular, yet always the same order. 0 as above. */
REG_API int reg_kdtree_within(const reg_kdtree *tree, sb_vec3 point, sb_real radius, int *indices, int room);

#endif /* REG_KDTREE_H */

#endif /* REGISTER_H */

#if defined(REG_IMPLEMENTATION) && !defined(REG_IMPLEMENTATION_DONE)
#define REG_IMPLEMENTATION_DONE

/* ==== src/register/rigid.c ==== */
/* rigid: motions and Kabsch's fit. */

REG_API reg_rigid reg_rigid_identity(void)
{
    reg_rigid motion;
    motion.rotation = sb_m3_identity();
    motion.translation = sb_v3(0, 0, 0);
    return motion;
}

REG_API sb_vec3 reg_rigid_apply(const reg_rigid *motion, sb_vec3 point)
{
    return sb_v3_add(sb_m3_apply(motion->rotation, point), motion->translation);
}

REG_API reg_rigid reg_rigid_compose(const reg_rigid *then, const reg_rigid *first)
{
    reg_rigid motion;
    motion.rotation = sb_m3_mul(then->rotation, first->rotation);
    motion.translation = reg_rigid_apply(then, first->translation);
    return motion;
}

REG_API reg_rigid reg_rigid_inverse(const reg_rigid *motion)
{
    reg_rigid inverse;
    inverse.rotation = sb_m3_transpose(motion->rotation);
    inverse.translation = sb_v3_scale(-1, sb_m3_apply(inverse.rotation, motion->translation));
    return inverse;
}

/* The axis times 2 sin, and 1 + 2 cos: together they tell small angles and such near pi alike. */
REG_API sb_real reg_rigid_angle(const reg_rigid *motion)
{
    const sb_mat3 *r = &motion->rotation;
    sb_vec3 axis = sb_v3(r->m[2][1] - r->m[1][2], r->m[0][2] - r->m[2][0], r->m[1][0] - r->m[0][1]);
    return (sb_real)atan2((double)sb_v3_norm(axis), (double)(r->m[0][0] + r->m[1][1] + r->m[2][2] - 1));
}

static sb_result regi_rigid_check(const sb_vec3 *from, const sb_vec3 *to, const sb_real *weights, int count,
                                  sb_error *error)
{
    sb_real largest = 0;
    if (!from || !to || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a fit needs at least one pair of points, not %d", count);
    for (int i = 0; i < count; i++) {
        sb_real w = weights ? weights[i] : 1;
        if (!sb_v3_is_finite(from[i]) || !sb_v3_is_finite(to[i]) || !sb_is_finite(w))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "pair %d is not finite", i);
        if (w < 0)
            return sbi_fail(error, SB_ERROR_ARGUMENT, "the weight of pair %d is %g, not 0 or more", i, (double)w);
        largest = w > largest ? w : largest;
    }
    if (!(largest > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "all weights are 0");
    return SB_OK;
}

REG_API sb_result reg_rigid_fit(const sb_vec3 *from, const sb_vec3 *to, const sb_real *weights, int count,
                                reg_rigid *motion, sb_error *error)
{
    sb_result result = regi_rigid_check(from, to, weights, count, error);
    sb_vec3 mean_from = sb_v3(0, 0, 0), mean_to = mean_from, stretches;
    sb_mat3 spread = sb_m3_zero(), u, v;
    sb_real total = 0;
    if (result != SB_OK)
        return result;
    for (int i = 0; i < count; i++) {
        sb_real w = weights ? weights[i] : 1;
        if (!(w > 0))
            continue;
        total += w;
        mean_from = sb_v3_madd(mean_from, w / total, sb_v3_sub(from[i], mean_from));
        mean_to = sb_v3_madd(mean_to, w / total, sb_v3_sub(to[i], mean_to));
    }
    for (int i = 0; i < count; i++) {
        sb_vec3 a = sb_v3_scale((weights ? weights[i] : 1) / total, sb_v3_sub(to[i], mean_to));
        spread = sb_m3_add(spread, sb_m3_outer(a, sb_v3_sub(from[i], mean_from)));
    }
    /* u and v of this factorisation are rotations, the sign of the determinant is in the last stretch: u v^T is the
     * nearest rotation. */
    sb_m3_svd(spread, &u, &stretches, &v);
    motion->rotation = sb_m3_mul(u, sb_m3_transpose(v));
    motion->translation = sb_v3_sub(mean_to, sb_m3_apply(motion->rotation, mean_from));
    return SB_OK;
}

/* ==== src/register/kdtree.c ==== */
/* kdtree: building by medians, and queries that walk down the nearer half first.
 *
 * The tree is complete: node i has the children 2i and 2i + 1, the leaves come last, and leaf j of L holds the points
 * from floor(n j / L) on. Distances and the bounds of boxes are sums of three squares in one order; each rounding is
 * monotone, so a bound never exceeds the distance of a point in the box, and nothing is lost to rounding. */

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

/* ---- building -------------------------------------------------------------------------------------------------- */

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
        out->x[i] = there ? p[from + i].x[0] : (sb_real)NAN;
        out->y[i] = there ? p[from + i].x[1] : (sb_real)NAN;
        out->z[i] = there ? p[from + i].x[2] : (sb_real)NAN;
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

REG_API int reg_kdtree_count(const reg_kdtree *tree) { return tree ? tree->count : 0; }

/* ---- queries ---------------------------------------------------------------------------------------------------- */

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

/* Squared distances to the points of a leaf; NaN, which no comparison takes, where there is none. */
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
    return sb_min(within * within, SB_REAL_MAX);
}

REG_API int reg_kdtree_nearest(const reg_kdtree *tree, sb_vec3 point, sb_real within, sb_real *squared)
{
    sb_real best = regi_kdtree_limit(within), d[REGI_KDTREE_LEAF];
    const regi_kdtree_leaf *leaf;
    regi_kdtree_walk walk;
    int found = INT_MAX;
    if (!tree || best < 0 || !sb_v3_is_finite(point))
        return -1;
    regi_kdtree_begin(&walk);
    while ((leaf = regi_kdtree_next(tree, &walk, point, best)) != NULL) {
        regi_kdtree_distances(leaf, point, d);
        for (int i = 0; i < REGI_KDTREE_LEAF; i++)
            if (d[i] <= best && (d[i] < best || leaf->index[i] < found)) {
                best = d[i];
                found = leaf->index[i];
            }
    }
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

#endif /* REG_IMPLEMENTATION */

/* ==== src/register/../softbody/end.h ==== */
/* end: gives back the settings that begin.h changed. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT DEFAULT
#elif defined(__GNUC__)
#if !defined(__STRICT_ANSI__) && (defined(__FP_FAST_FMA) || defined(__FP_FAST_FMAF))
#pragma GCC pop_options
#endif
#endif

/*
softbody is available under two licences; choose the one you like.

------------------------------------------------------------------------------
ALTERNATIVE A - MIT License

Copyright (c) 2025 the softbody authors

Permission is hereby granted, free of charge, to any person obtaining a copy of
this software and associated documentation files (the "Software"), to deal in
the Software without restriction, including without limitation the rights to
use, copy, modify, merge, publish, distribute, sublicense, and/or sell copies
of the Software, and to permit persons to whom the Software is furnished to do
so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all
copies or substantial portions of the Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR
IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY,
FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
AUTHORS OR COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER
LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM,
OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE
SOFTWARE.

------------------------------------------------------------------------------
ALTERNATIVE B - Public Domain (www.unlicense.org)

This is free and unencumbered software released into the public domain.

Anyone is free to copy, modify, publish, use, compile, sell, or distribute this
software, either in source code form or as a compiled binary, for any purpose,
commercial or non-commercial, and by any means.

In jurisdictions that recognize copyright laws, the author or authors of this
software dedicate any and all copyright interest in the software to the public
domain. We make this dedication for the benefit of the public at large and to
the detriment of our heirs and successors. We intend this dedication to be an
overt act of relinquishment in perpetuity of all present and future rights to
this software under copyright law.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR
IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY,
FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
AUTHORS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN
ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION
WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE.
*/
