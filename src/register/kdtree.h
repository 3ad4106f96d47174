/* kdtree: nearest points of a cloud. Floor 6.
 *
 * A balanced tree over a copy of the points, eight to a leaf and side by side there; every node knows the smallest
 * boxes around its halves. Queries allocate and change nothing, so any number of threads may ask at once, and give the
 * same answer whatever the tree looks like: of points equally far, the one with the smallest index counts as nearer. */
#ifndef REG_KDTREE_H
#define REG_KDTREE_H

#include "api.h"

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

#if defined(REG_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* The points' indices in the order of the leaves, so that queries in this order find what they need in the cache:
 * order[count]. */
REGI_API void regi_kdtree_order(const reg_kdtree *tree, int *order);
/* reg_kdtree_nearest for a finite point, with the answer to begin with: index `found` (INT_MAX: none) at the squared
 * distance *squared. */
REGI_API int regi_kdtree_nearest_from(const reg_kdtree *tree, sb_vec3 point, int found, sb_real *squared);
#endif

#endif /* REG_KDTREE_H */
