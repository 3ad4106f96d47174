/* cpd_private: what coherent point drift shares among its parts. Internal: cpd_sums.c finds expected partners,
 * cpd_kernel.c factors the kernel and solves for the deformation, cpd.c iterates. All in the frames of the clouds. */
#ifndef REGI_CPD_STATE_H
#define REGI_CPD_STATE_H

#include "cpd.h"

enum {
    REGI_CPD_LANES = 16, /* points of a block: a loop of fixed length, which compilers vectorise at -O2 */
    REGI_CPD_CHUNKS = 8  /* parts of the target with sums of their own: tasks, whatever the number of threads */
};

/* Coordinates of a block of points. The last block is filled up with its last point. */
typedef struct regi_cpd_block {
    double x[REGI_CPD_LANES], y[REGI_CPD_LANES], z[REGI_CPD_LANES];
} regi_cpd_block;

typedef struct regi_cpd_box {
    double low[3], high[3];
} regi_cpd_box;

/* A cloud in an order that keeps neighbours together. */
typedef struct regi_cpd_cloud {
    int count, blocks;
    int *order;             /* [count] the caller's index of each point */
    regi_cpd_block *points; /* [blocks] */
    regi_cpd_box *boxes;    /* [blocks] */
} regi_cpd_cloud;

/* What a block of source points gathers: sum_n P_mn, and sum_n P_mn (x_n - T y_m), which keeps digits that the sum of
 * P x loses once sigma is small. */
typedef struct regi_cpd_sums {
    double p[REGI_CPD_LANES], x[REGI_CPD_LANES], y[REGI_CPD_LANES], z[REGI_CPD_LANES];
} regi_cpd_sums;

typedef struct regi_cpd_totals {
    double explained; /* sum P */
    double squares;   /* sum P |x_n - T y_m|^2 */
    double logs;      /* sum_n -log(sum_m exp(-|x_n - T y_m|^2 / 2 s2) + c) */
    double pairs;
} regi_cpd_totals;

/* Most probable partner of each source point. */
typedef struct regi_cpd_best {
    double probability[REGI_CPD_LANES];
    int target[REGI_CPD_LANES]; /* the caller's index, or -1 */
} regi_cpd_best;

/* One evaluation of all P_mn. */
typedef struct regi_cpd_expectation {
    const regi_cpd_cloud *target;
    const regi_cpd_cloud *source;            /* boxes: of the moved points */
    const regi_cpd_block *moved;             /* [source blocks] */
    double sigma2, outlier;                  /* outlier: c, in the sum beside the Gaussians */
    double tolerance;                        /* share of each target point that may be left out */
    regi_cpd_sums *sums;                     /* [CHUNKS][source blocks]; the first row becomes the result */
    regi_cpd_totals totals[REGI_CPD_CHUNKS]; /* likewise */
    double (*terms)[REGI_CPD_LANES];         /* [CHUNKS][source blocks] */
    int *near_blocks;                        /* [CHUNKS][source blocks] */
    regi_cpd_best *best;                     /* [source blocks], or NULL: not wanted */
} regi_cpd_expectation;

/* The factor of the kernel, G = L L^T to the tolerance, by columns. */
typedef struct regi_cpd_kernel {
    sb_allocator allocator;
    int rank, capacity;
    size_t rows;      /* source points, filled up to whole blocks; those rows are 0 */
    double inverse;   /* 1 / (2 beta^2) */
    double *columns;  /* [capacity][rows] */
    int *pivots;      /* [capacity] rows */
    double *diagonal; /* [rows] what is left of the diagonal; -1: a pivot */
    double *system;   /* [rank][stride] L^T P L + lambda s2, then its Cholesky factor, lower half */
    double *scaled;   /* [rank][REGI_CPD_SLICE] */
    size_t stride;
    double *weights[3]; /* [stride] c: T = Y + L c */
} regi_cpd_kernel;

#if defined(REG_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* Fills sums, totals[0] and best. Allocates nothing. */
REGI_API void regi_cpd_expect(regi_cpd_expectation *e, const sb_jobs *jobs);
REGI_API void regi_cpd_bound(const regi_cpd_block *points, int blocks, regi_cpd_box *boxes);

/* Factors the kernel of `points`, until the largest remaining diagonal entry is within tolerance or at max_rank
 * columns. On failure (SB_ERROR_MEMORY) free it, too. */
REGI_API sb_result regi_cpd_kernel_create(const regi_cpd_cloud *source, double beta, double tolerance, int max_rank,
                                          const sb_allocator *allocator, regi_cpd_kernel *kernel, sb_error *error);
REGI_API void regi_cpd_kernel_free(regi_cpd_kernel *kernel);
/* weights = (L^T P L + ridge)^-1 L^T r; p[rows], r[3][rows] in the order of the source. Returns |weights|^2. */
REGI_API double regi_cpd_kernel_solve(regi_cpd_kernel *kernel, const double *p, double *const r[3], double ridge,
                                      const sb_jobs *jobs);
/* a = l l^T in place, lower half, by strips of columns; a is known to be at least `ridge` above singular. */
REGI_API void regi_cpd_factor(double *a, int n, size_t stride, double ridge);
/* b becomes (l l^T)^-1 b. */
REGI_API void regi_cpd_back_solve(const double *l, int n, size_t stride, double *b);
/* moved = points + L weights. */
REGI_API void regi_cpd_kernel_move(const regi_cpd_kernel *kernel, const regi_cpd_block *points, regi_cpd_block *moved);
/* weights become those of the Gaussians at the pivots. */
REGI_API void regi_cpd_kernel_spread(regi_cpd_kernel *kernel);
#endif

#endif /* REGI_CPD_STATE_H */
