/* precond_fsai: a factorised sparse approximate inverse. Floor 1, internal.
 *
 * A^-1 is taken as G^T G with G lower triangular on the pattern of the lower part of |A|^power. Row i of G is the last
 * block row of L^-1 where L L^T = A_JJ, J the columns of the row: that minimises |I - G L_A|_F over the pattern, L_A
 * being the whole factor of A (Kolotilina and Yeremin 1993). Rows do not depend on each other, so they are made, and
 * the two products applied, by any number of threads with the same bits. */
#ifndef SB_PRECOND_FSAI_H
#define SB_PRECOND_FSAI_H

#include "sparse.h"

enum { SBI_FSAI_TASKS = 32 }; /* a scratch matrix each; more than the cores at hand, so that none waits long */

/* An entry of the diagonal, in terms of the mean one, with an inverse that floats have: crumbs of cut tissue weigh
 * 1e-40 of a node. What is raised is solved for slowly, by residuals too small to count. */
SB_INLINE float sbi_precond_in_range(double entry) { return entry > 0 && entry < 1e-30 ? 1e-30f : (float)entry; }

/* Blocks are three rows of four floats, the fourth 0. G is stored twice, by rows and by columns, so that both products
 * have one writer per row. */
typedef struct sbi_fsai {
    int row_count, power;
    int entry_count;
    int *start;           /* [row_count + 1] of the rows of G */
    int *columns;         /* [entry_count] ascending, the diagonal last */
    float *rows;          /* [entry_count][12] transposed blocks G_ij^T */
    int *back;            /* [entry_count] place of each block among those by columns */
    int *end;             /* [row_count + 1] of the columns of G */
    int *members;         /* [entry_count] row of each block of a column, ascending */
    float *turned;        /* [entry_count][12] blocks G_ij by columns */
    int *task_row;        /* [SBI_FSAI_TASKS + 1] first row of each task of an update */
    size_t *task_scratch; /* [SBI_FSAI_TASKS] where the task's scratch starts */
    float *scratch;
    int *bad;       /* [SBI_FSAI_TASKS] first row that failed, or -1 */
    double *shifts; /* [SBI_FSAI_TASKS] largest of the task's rows */
    void *memory;   /* the one block behind all arrays */
    size_t bytes;
} sbi_fsai;

/* SB_OK, or SB_ERROR_MEMORY (also when the pattern has more than INT_MAX blocks) with *fsai untouched. */
SBI_API sb_result sbi_fsai_create(const sb_matrix *pattern, int power, const sb_allocator *allocator, sbi_fsai *fsai);
SBI_API void sbi_fsai_free(const sb_allocator *allocator, sbi_fsai *fsai);

/* G of scale A. A row whose A_JJ has no Cholesky factor in single precision gets one of A_JJ with its diagonal times
 * 1 + shift, the smallest of 0.001, 0.002 ... that does. Returns -1, or the first row that no shift up to `most` helps;
 * *shift is the largest that was needed. */
SBI_API int sbi_fsai_update(sbi_fsai *fsai, const sb_matrix *a, double scale, double most, const sb_jobs *jobs,
                            double *shift);

/* The blocks by columns from those by rows. */
SBI_API void sbi_fsai_mirror(sbi_fsai *fsai);

/* out = G in, and out = G^T in, of the rows first <= i < last; vectors are [row_count][4]. */
SBI_API void sbi_fsai_multiply(const sbi_fsai *fsai, const float *in, float *out, int first, int last);
SBI_API void sbi_fsai_multiply_transposed(const sbi_fsai *fsai, const float *in, float *out, int first, int last);

#endif /* SB_PRECOND_FSAI_H */
