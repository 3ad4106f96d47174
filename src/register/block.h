/* block: products of dense matrices of doubles, in tiles that the registers hold. Floor 6, internal.
 *
 * Each sum runs over the depth in ascending order and is then added: the same bits whatever the vectors' width. */
#ifndef REGI_BLOCK_H
#define REGI_BLOCK_H

#include "../softbody/base/lanes.h"
#include "api.h"

/* Sums over `depth` of products of left[k left_stride + i] and right[k right_step + j right_stride]. */
typedef struct regi_block {
    const double *left, *right;
    size_t left_stride, right_step, right_stride;
    int depth;
    int wide; /* what sbi_lanes_are_wide() said */
} regi_block;

enum {
    REGI_BLOCK_ROWS = 4, /* j of a tile, */
    REGI_BLOCK_WIDTH = 8 /* and i */
};

/* to[j stride + i] += factor * the sums, i < width, j < rows. */
REGI_API void regi_block_add(const regi_block *block, int width, int rows, double factor, double *to, size_t stride);
/* x[n][REGI_BLOCK_WIDTH] <- U^-T x for the upper u[n][stride]. */
REGI_API void regi_block_forward(int wide, const double *u, int n, size_t stride, double *x);
/* x[n][REGI_BLOCK_WIDTH] <- U^-1 x */
REGI_API void regi_block_backward(int wide, const double *u, int n, size_t stride, double *x);

#endif /* REGI_BLOCK_H */
