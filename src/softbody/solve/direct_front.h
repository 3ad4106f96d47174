/* direct_front: the dense arithmetic of a front of the sparse factor. Floor 1, internal.
 *
 * Panels are stored by columns, `height` apart. Every entry is a sum in one order, whatever the vectors' width and
 * however many right-hand sides there are: the bits do not depend on either. `wide`: what sbi_lanes_are_wide() said. */
#ifndef SB_DIRECT_FRONT_H
#define SB_DIRECT_FRONT_H

#include "../base/lanes.h"
#include "direct.h"

/* Bytes of a vector of the processor, or of the one that it is asked for; 0: plain code. */
#if defined(__GNUC__) && !defined(SB_NO_VECTORS)
#if defined(__AVX512F__)
#define SBI_FRONT_BYTES 64
#elif defined(__AVX__) || SBI_IS_WIDENED
#define SBI_FRONT_BYTES 32
#else
#define SBI_FRONT_BYTES 16
#endif
enum { SBI_FRONT_WIDTH = SBI_FRONT_BYTES / (int)sizeof(sb_real) };
#else
#define SBI_FRONT_BYTES 0
enum { SBI_FRONT_WIDTH = 2 };
#endif

enum {
    SBI_FRONT_GROUP = 2 * SBI_FRONT_WIDTH, /* right-hand sides solved at once; also the rows of a product's tile */
    SBI_FRONT_REACH = SBI_FRONT_GROUP + 4, /* rows above the diagonal that a square's tiles may touch */
    SBI_FRONT_DEPTH = 128,                 /* columns of a product's packed pieces, */
    SBI_FRONT_ROWS = 64,                   /* rows of the left one, */
    SBI_FRONT_COLUMNS = 128,               /* and of the right one */
    SBI_FRONT_PACK = SBI_FRONT_DEPTH * (SBI_FRONT_ROWS + SBI_FRONT_COLUMNS)
};

/* A = L S L^T of the first `width` columns of a panel [height][width], in place; S holds signs[width], all 1 unless
 * `indefinite`. sizes: [width] largest entry of each row of the matrix. Returns -1, or the column whose pivot is
 * lost. */
SBI_API int sbi_front_factor(sb_real *panel, size_t height, size_t width, int indefinite, sb_real *signs,
                             const sb_real *sizes, sb_real *pack, int wide, sb_direct_info *info);
/* square -= B S B^T, lower triangle, for the rows B below the first `width` of a factored panel. */
SBI_API void sbi_front_square(const sb_real *panel, size_t height, size_t width, int indefinite, const sb_real *signs,
                              sb_real *square, sb_real *pack, int wide);
/* Forward and backward substitution of a front's columns in x[height][group], group 1 or SBI_FRONT_GROUP; the rows
 * below the first `width` are changed forward and read backward. */
SBI_API void sbi_front_forward(const sb_real *panel, size_t height, size_t width, sb_real *x, int group, int wide);
SBI_API void sbi_front_backward(const sb_real *panel, size_t height, size_t width, sb_real *x, int group, int wide);
/* Forward substitution of `count` groups at once, x[count][height][SBI_FRONT_GROUP], by products of packed pieces: for
 * many groups much less than one by one; sums are in another order than theirs. */
SBI_API void sbi_front_forward_many(const sb_real *panel, size_t height, size_t width, sb_real *x, int count,
                                    sb_real *pack, int wide);
/* Backward substitution of a front's columns for `count` groups at once: x[count][stride][SBI_FRONT_GROUP],
 * rows[height] where the front's are there, its own side by side. */
SBI_API void sbi_front_backward_many(const sb_real *panel, size_t height, size_t width, const int *rows, sb_real *x,
                                     size_t stride, int count, sb_real *pack, int wide);

#endif /* SB_DIRECT_FRONT_H */
