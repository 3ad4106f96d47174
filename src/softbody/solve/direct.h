/* direct: sparse Cholesky and LDL^T factorisation of symmetric block matrices. Floor 1. */
#ifndef SB_DIRECT_H
#define SB_DIRECT_H

#include "../base/dense.h"
#include "sparse.h"

typedef enum sb_direct_kind {
    SB_DIRECT_CHOLESKY = 0, /* A = L L^T of a positive definite matrix: the default */
    SB_DIRECT_LDLT = 1      /* A = L D L^T with the signs of D as they come, without pivoting: for matrices every
                             * symmetric permutation of which has such a factor, as the quasi-definite [K B^T; B -C]
                             * with K and C positive definite */
} sb_direct_kind;

typedef struct sb_direct_def {
    sb_direct_kind kind;
    const sb_vec3 *positions; /* [row_count] of the nodes (m), read at creation only: they help to find an order with
                               * little fill. NULL (default): the pattern alone has to do */
} sb_direct_def;

/* What a solver is and how its last update went. */
typedef struct sb_direct_info {
    int unknowns;          /* 3 row_count */
    int fronts;            /* dense pieces that the factor is made of */
    int largest_front;     /* rows of the largest */
    double factor_entries; /* of L, with the zeros that are stored */
    double multiply_adds;  /* of an update; a solve takes 2 factor_entries */
    size_t bytes;          /* memory held */
    sb_real least_pivot;   /* of the last update: smallest |pivot| / largest |entry| of its row; about the inverse
                            * of the condition at best. 0 before the first */
    int negative_pivots;   /* of the last update (LDL^T): how many eigenvalues are negative */
} sb_direct_info;

/* The factor of matrices of one pattern. Multifrontal: nested dissection cuts the nodes by small separators; the
 * factor is computed in dense fronts, from the leaves of the dissection to the root, each with block operations.
 * Worth its while for small and for stiff systems, for many right-hand sides, and where iterations fail: for n nodes of
 * a solid L has some n^(4/3) blocks and takes some n^2 block operations; n from 1 to some 30,000. */
typedef struct sb_direct sb_direct;

SB_API sb_direct_def sb_default_direct_def(void);

/* Orders and analyses the pattern (values are not read) and takes all memory that is ever needed. allocator NULL:
 * malloc. def NULL: the default. *direct is released with sb_direct_free and refers to neither def nor pattern.
 * Returns SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE (a position, error->node) or SB_ERROR_MEMORY; *direct is then
 * untouched. */
SB_API sb_result sb_direct_create(const sb_direct_def *def, const sb_matrix *pattern, const sb_allocator *allocator,
                                  sb_direct **direct, sb_error *error);
SB_API void sb_direct_free(sb_direct *direct); /* NULL is fine */

/* Factors a symmetric matrix of the pattern; allocates nothing. Returns SB_ERROR_ARGUMENT (another pattern),
 * SB_ERROR_NOT_FINITE (error->node) or SB_ERROR_INDEFINITE when a pivot is negative (Cholesky) or lost in rounding
 * (error->node tells its node). After an error it must be updated again before it can solve. */
SB_API sb_result sb_direct_update(sb_direct *direct, const sb_matrix *matrix, sb_error *error);

/* Solves A x = rhs for `count` right-hand sides; rhs and x are [count][row_count][3] and may be the same array. Several
 * at once cost much less than one after the other, and each gives the bits that it gives alone. Uses the solver's
 * scratch: one call at a time. Returns SB_ERROR_ARGUMENT (also when the last update failed): x is then untouched. */
SB_API sb_result sb_direct_solve(sb_direct *direct, const sb_real *rhs, sb_real *x, int count);

SB_API sb_direct_info sb_direct_get_info(const sb_direct *direct);

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* order[k] is the node eliminated k-th, by nested dissection. Scratch from the allocator, released again. */
SBI_API sb_result sbi_direct_order(const sb_matrix *pattern, const sb_vec3 *positions, const sb_allocator *allocator,
                                   int *order, sb_error *error);
/* The entries of L as they are kept, and their number, which follows from the pattern and the order. */
SBI_API sb_real *sbi_direct_values(sb_direct *direct, size_t *count);
/* Says that the caller has set the values. */
SBI_API void sbi_direct_take_values(sb_direct *direct);
#endif

#endif /* SB_DIRECT_H */
