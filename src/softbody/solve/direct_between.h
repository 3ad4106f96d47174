/* direct_between: products of many sparse vectors with the inverse between them. Floor 1, internal.
 *
 *     sbi_between_create(direct, lefts, rights, entries, NULL, &between, &error);
 *     sbi_between_add(between, column, node, value);       (the lefts' columns first, then the rights')
 *     sbi_between_run(between);                            (the factor of now)
 *     sbi_between_get(between, left, right)                left^T A^-1 right
 *
 * With A = L L^T that is the product of L^-1 left and L^-1 right: each side goes through the forward substitution
 * alone, which begins where a vector has entries and passes no front but the way from there to the root; and each front
 * adds its rows to the products of the vectors that come by. For local vectors, as of nodes of a surface, that takes
 * half to a third of solving for one side and multiplying with the other. */
#ifndef SB_DIRECT_BETWEEN_H
#define SB_DIRECT_BETWEEN_H

#include "direct.h"

typedef struct sbi_between sbi_between;

/* Takes all memory that is ever needed for as many vectors and entries; refers to the direct solver, which outlives it.
 * allocator NULL: malloc. SB_ERROR_MEMORY. */
SBI_API sb_result sbi_between_create(const sb_direct *direct, int lefts, int rights, size_t entries,
                                     const sb_allocator *allocator, sbi_between **between, sb_error *error);
SBI_API void sbi_between_free(sbi_between *between); /* NULL is fine */
/* All vectors are 0 again. */
SBI_API void sbi_between_clear(sbi_between *between);
/* Adds what a vector has at a node; entries of one node add up. Column: a left one, or lefts + a right one. */
SBI_API void sbi_between_add(sbi_between *between, int column, int node, sb_vec3 value);
/* All products. SB_ERROR_ARGUMENT: the direct solver has no factor. The same bits whatever the vectors' width. */
SBI_API sb_result sbi_between_run(sbi_between *between);
SBI_API sb_real sbi_between_get(const sbi_between *between, int left, int right);

#endif /* SB_DIRECT_BETWEEN_H */
