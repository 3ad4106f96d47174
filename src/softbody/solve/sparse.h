/* sparse: square 3x3 block matrices with a symmetric pattern, their products and constraints. Floor 1. */
#ifndef SB_SPARSE_H
#define SB_SPARSE_H

#include "../base/core.h"

/* Bits of a node's constraint mask: which of its displacement components are prescribed. */
enum { SB_X = 1, SB_Y = 2, SB_Z = 4, SB_XYZ = 7 };

/* A square matrix of 3x3 blocks in compressed rows: block q of row i (row_start[i] <= q < row_end[i])
 * couples node i with node columns[q]. Columns ascend in each row, the diagonal block is always there, and
 * for every block (i, j) there is a block (j, i): the pattern is symmetric and stored whole.
 *
 * Whole storage costs twice the memory of one triangle, but then a row of a product has one writer: rows can
 * be shared among threads and the sums keep their order, so the bits do not depend on the thread count. */
typedef struct sb_matrix {
    int row_count;        /* nodes */
    int block_count;      /* extent of the arrays of blocks */
    int *row_start;       /* [row_count + 1] first block of each row */
    int *row_end;         /* [row_count] one past its last block. Rows follow each other without a gap, row_end[i] =
                           * row_start[i + 1], unless the matrix follows a mesh that changes */
    int *columns;         /* [block_count] */
    int *diagonal;        /* [row_count] position of block (i, i) */
    int *transpose;       /* [block_count] position of block (j, i) for the block (i, j) */
    int part_count;       /* connected parts: no block couples a row with one of another part */
    int *part_start;      /* [part_count + 1] into part_rows; parts are in the order of their first rows */
    int *part_rows;       /* [row_count] rows by part, ascending in each; rows that have their diagonal block only are
                           * one part together */
    unsigned char *fixed; /* [row_count] mask of the last sb_matrix_constrain; 0: free */
    sb_real (*blocks)[9]; /* [block_count] row-major, 64-byte aligned, with one sb_real to spare at the end */
    void *memory;         /* the one allocation behind all arrays */
    struct sbi_matrix_live *live; /* internal, of a matrix that follows a mesh that changes; otherwise NULL */
    sb_allocator allocator;
} sb_matrix;

/* Makes the matrix whose nodes are coupled when they share a cell (an element, a particle's neighbours ...);
 * all values are zero. Nodes without a cell keep their diagonal block.
 * node_count      number of nodes, >= 1
 * cell_count      number of cells, >= 0
 * nodes_per_cell  nodes of each cell, >= 1; ignored when cell_start is given
 * cell_start      [cell_count + 1] first entry of each cell in `cells`, ascending from 0; NULL: fixed size
 * cells           node indices of the cells; a node may repeat within a cell
 * allocator       NULL: malloc
 * Returns SB_ERROR_ARGUMENT, SB_ERROR_INDEX (error->element is the cell) or SB_ERROR_MEMORY (also when there
 * would be more than 2^31-1 blocks) with *matrix untouched. Release with sb_matrix_free. Time and scratch
 * memory are proportional to the cells' node pairs. */
SB_API sb_result sb_matrix_create(int node_count, int cell_count, int nodes_per_cell, const int *cell_start,
                                  const int *cells, const sb_allocator *allocator, sb_matrix *matrix, sb_error *error);

/* Releases the arrays and zeroes the struct; a zeroed matrix is fine. */
SB_API void sb_matrix_free(sb_matrix *matrix);

/* Sets all values to zero and clears the constraint mask. */
SB_API void sb_matrix_clear(sb_matrix *matrix);

/* Position of block (i, j), or -1 when the pattern has none or an index is out of range. Time O(log row). */
SB_API int sb_matrix_find(const sb_matrix *matrix, int i, int j);

/* y = A x; x and y are [row_count][3] and must not overlap. jobs NULL: inline. */
SB_API void sb_matrix_multiply(const sb_matrix *matrix, const sb_real *x, sb_real *y, const sb_jobs *jobs);

/* Largest |A_ij - A_ji| divided by the largest |A_ij|; 0 for a zero matrix, NaN when an entry is. */
SB_API sb_real sb_matrix_asymmetry(const sb_matrix *matrix);

/* Mean of |A_kk| over the free scalar rows (mask NULL: all), the scale given to constrained ones; 1 when
 * there are none or all are zero, not finite when an entry is not. */
SB_API sb_real sb_matrix_diagonal_scale(const sb_matrix *matrix, const unsigned char *mask);

/* Replaces the equations of prescribed components by s x_k = s value_k, s = sb_matrix_diagonal_scale, keeping
 * symmetry: the known terms move to the right-hand side, rhs -= A[:, k] value_k, before rows and columns k
 * are zeroed.
 * mask    [row_count] SB_X | SB_Y | SB_Z; copied into matrix->fixed
 * values  [row_count][3] prescribed values, read where the mask says so; NULL: all zero
 * rhs     [row_count][3] changed in place; NULL: only the matrix is changed
 * Needs a symmetric matrix; touches the constrained rows and their transposed blocks only. The diagonal stays
 * as large as its neighbours so that neither the condition number nor a relative residual notices the
 * replaced rows. */
SB_API void sb_matrix_constrain(sb_matrix *matrix, const unsigned char *mask, const sb_real *values, sb_real *rhs);

/* ---- internal ------------------------------------------------------------------------------------------ */

/* Rows per task of products and vector loops: fixed, so that partial sums do not depend on threads. */
enum { SBI_ROW_CHUNK = 256 };

SB_INLINE int sbi_row_chunks(int row_count) { return row_count / SBI_ROW_CHUNK + (row_count % SBI_ROW_CHUNK != 0); }

/* As many parts as a matrix of so many rows can have: two rows each at least, but for those coupled with no other. */
SB_INLINE int sbi_matrix_most_parts(int row_count) { return row_count / 2 + 1; }

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* y_i = (A x)_i for the rows first <= i < last. */
SBI_API void sbi_matrix_multiply_rows(const sb_matrix *matrix, const sb_real *x, sb_real *y, int first, int last);
/* x . A x of a symmetric A, by its upper half. */
SBI_API double sbi_matrix_work(const sb_matrix *matrix, const sb_real *x, const sb_jobs *jobs);
/* sb_matrix_diagonal_scale, and sb_matrix_constrain with the mean that it needs, on all threads. */
SBI_API sb_real sbi_matrix_diagonal_scale(const sb_matrix *matrix, const unsigned char *mask, const sb_jobs *jobs);
SBI_API void sbi_matrix_constrain(sb_matrix *matrix, const unsigned char *mask, const sb_real *values, sb_real *rhs,
                                  const sb_jobs *jobs);
#endif

#endif /* SB_SPARSE_H */
