/* multigrid: V-cycles over levels made from the matrix alone. Floor 1.
 *
 * Level 0 is the matrix itself. A coarser level has fewer nodes and weights P that interpolate its displacements to the
 * nodes of the level above it; its matrix is P^T A P (Galerkin). So rotations, materials, supports, loads and
 * constraints need no second look: whatever is in the matrix is on every level. */
#ifndef SB_MULTIGRID_H
#define SB_MULTIGRID_H

#include "../base/mapping.h"
#include "sparse.h"

/* A coarser level of one's own. Its displacements u give those of the finer level's nodes: node i of the finer one
 * moves by sum_k weights[k] u[nodes[k]], row_start[i] <= k < row_start[i + 1] (a row may be empty: such a node does
 * not follow). Weights that sum to 1 and reproduce positions (barycentric coordinates) make good levels. */
typedef struct sb_multigrid_level {
    sb_mapping mapping;       /* row_count = nodes of the finer level */
    int node_count;           /* nodes of this level, >= 1 */
    const sb_vec3 *positions; /* [node_count] (m) */
} sb_multigrid_level;

/* ---- internal ------------------------------------------------------------------------------------------ */

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
typedef struct sbi_multigrid sbi_multigrid;

/* What updates remember: how far above the mean of the finest level's eigenvalues its bound was found to lie, in their
 * deviations (0: not known), and how many updates have used it since. */
#define SBI_MG_MAX_REACH 100.0
typedef struct sbi_mg_reach {
    double deviations; /* below SBI_MG_MAX_REACH */
    int age;
} sbi_mg_reach;

typedef struct sbi_multigrid_setup {
    const sb_vec3 *positions;         /* [row_count] (m) of the finest nodes */
    const sb_real *moduli;            /* [block_count] (Pa) as in sb_preconditioner_def, or NULL */
    const sb_multigrid_level *levels; /* [level_count] from fine to coarse; more are made below the last */
    int level_count;
    const sbi_multigrid *like; /* take the user's levels, Poisson's ratio and, without moduli, the regions from here
                                * instead, or NULL */
    sb_jobs jobs;
} sbi_multigrid_setup;

/* Makes levels and plans for matrices of the pattern, with all memory they ever need. Values are not read. The setup
 * must be valid but for its levels: SB_ERROR_ARGUMENT, SB_ERROR_INDEX or SB_ERROR_NOT_FINITE name what is wrong with
 * one. Freed with sbi_multigrid_free; refers to neither setup nor pattern. */
SBI_API sb_result sbi_multigrid_create(const sbi_multigrid_setup *setup, const sb_matrix *pattern,
                                       const sb_allocator *allocator, sbi_multigrid **out, sb_error *error);
SBI_API void sbi_multigrid_free(sbi_multigrid *multigrid);
/* Poisson's ratio of what the matrix is of, for all updates to come; 0 until then, or that of setup->like. */
SBI_API void sbi_multigrid_set_poisson(sbi_multigrid *multigrid, double poisson);
/* Takes over the values of a symmetric matrix of the pattern times `scale`, a power of two that brings its diagonal
 * near 1. Returns -1, or the node whose diagonal block is not positive definite. Allocates nothing. */
SBI_API int sbi_multigrid_update(sbi_multigrid *multigrid, const sb_matrix *matrix, double scale);
/* z = M^-1 r of the scaled matrix; r is taken times `scale`, z times `back`; both [row_count][3]. */
SBI_API void sbi_multigrid_apply(sbi_multigrid *multigrid, const sb_real *r, sb_real scale, sb_real *z, sb_real back);
/* Doubles the bounds that the smoothers work with, for a matrix whose largest eigenvalue the update missed; the next
 * update starts afresh. Returns 0 when that was done before as often as it can make sense. */
SBI_API int sbi_multigrid_soften(sbi_multigrid *multigrid);
/* The matrix of the last update in 32 bits an entry, to multiply by. Its product differs from the matrix's own by at
 * most sbi_multigrid_deviation() |S x|, S x being what sbi_multigrid_spread makes of x; 0: there is none (float builds;
 * where moduli jump; matrices that are not positive definite or not finite). The first of these writes rows
 * first <= i < last of S x and returns the sum of their squares, the second writes rows of y = A x when all of S x is
 * there. */
SBI_API double sbi_multigrid_deviation(const sbi_multigrid *multigrid);
SBI_API double sbi_multigrid_spread(sbi_multigrid *multigrid, const sb_real *x, int first, int last);
SBI_API void sbi_multigrid_multiply(const sbi_multigrid *multigrid, sb_real *y, int first, int last);
SBI_API sbi_mg_reach sbi_multigrid_get_reach(const sbi_multigrid *multigrid);
SBI_API void sbi_multigrid_set_reach(sbi_multigrid *multigrid, sbi_mg_reach reach);
/* 1: levels of the user's have nodes that move several connected parts of the pattern; others never do. */
SBI_API int sbi_multigrid_couples_parts(const sbi_multigrid *multigrid);
SBI_API int sbi_multigrid_levels(const sbi_multigrid *multigrid);
SBI_API size_t sbi_multigrid_bytes(const sbi_multigrid *multigrid);
#endif

#endif /* SB_MULTIGRID_H */
