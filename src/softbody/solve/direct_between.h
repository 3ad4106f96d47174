/* direct_between: products of many sparse vectors with the inverse between them. Floor 1, internal.
 *
 *     sbi_between_create(direct, lefts, rights, entries, NULL, &between, &error);
 *     sbi_between_add(between, left, node, value);
 *     sbi_between_run(between, &rights);                   (the factor of now)
 *     sbi_between_get(between, left, right)                left^T A^-1 right, of a right along each axis
 *
 * Lefts are solved for, all at once: the forward substitution begins where a vector has entries and passes no front but
 * the way from there to the root, and each panel of the factor comes from memory once for all of them. Take the side
 * with less vectors, counting rights three times, for the left one. */
#ifndef SB_DIRECT_BETWEEN_H
#define SB_DIRECT_BETWEEN_H

#include "direct.h"

typedef struct sbi_between sbi_between;

/* Weights of nodes: right columns[k] has weights[k] at a node for start[node] <= k < start[node + 1], [nodes + 1];
 * along each of the axes. */
typedef struct sbi_between_rights {
    const int *start, *columns;
    const sb_real *weights;
} sbi_between_rights;

/* Takes all memory that is ever needed for as many vectors, and entries of lefts; refers to the direct solver, which
 * outlives it. allocator NULL: malloc. SB_ERROR_MEMORY. */
SBI_API sb_result sbi_between_create(const sb_direct *direct, int lefts, int rights, size_t entries,
                                     const sb_allocator *allocator, sbi_between **between, sb_error *error);
SBI_API void sbi_between_free(sbi_between *between); /* NULL is fine */
/* All lefts are 0 again. */
SBI_API void sbi_between_clear(sbi_between *between);
/* Adds what a left has at a node; entries of one node add up. */
SBI_API void sbi_between_add(sbi_between *between, int left, int node, sb_vec3 value);
/* All products. SB_ERROR_ARGUMENT: the direct solver has no factor. The same bits whatever the vectors' width. */
SBI_API sb_result sbi_between_run(sbi_between *between, const sbi_between_rights *rights);
SBI_API sb_vec3 sbi_between_get(const sbi_between *between, int left, int right);

#endif /* SB_DIRECT_BETWEEN_H */
