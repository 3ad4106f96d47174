/* gauss: the linear Gaussian model behind an inference: data that loads and a pose explain. Floor 6, internal.
 *
 *     gap = V c + R p + noise,   c ~ N(0, scale^2 I) with B c = 0,   p ~ N(0, I),   noise ~ N(0, diag(variance))
 * Each of the m gaps is a datum; a column of V is what a unit of one load does to all data, B are resultants that loads
 * must not have. The posterior is found in the data (m x m), whatever the number of loads:
 *     S = scale^2 V V^T + R R^T + diag(variance),   y = S^-1 gap,   c = scale^2 V^T y,   p = R^T y.
 * It knows nothing of meshes. Everything is in double, in one order: the same bits everywhere. */
#ifndef REGI_GAUSS_H
#define REGI_GAUSS_H

#include "block.h"

enum {
    REGI_GAUSS_POSES = 7, /* most columns of R, */
    REGI_GAUSS_EXACT = 6, /* rows of B, */
    REGI_GAUSS_RANK = 96, /* and directions of the data that the evidence is found in */
    REGI_GAUSS_WIDTH = REGI_GAUSS_POSES + REGI_GAUSS_RANK + 1
};

typedef struct regi_gauss {
    int most, most_loads; /* room for data and loads */
    int count, loads;     /* m and the columns of V */
    int poses, exact;     /* columns of R; rows of B, or 0 */
    int wide;             /* what sbi_lanes_are_wide() said */
    double scale;         /* sd of a load */
    double *columns;      /* [loads][most] V^T */
    double *resultants;   /* [exact][most_loads] B; orthonormal once bound */
    double *pose;         /* [poses][most] R^T */
    double *gap;          /* [count] */
    double *variance;     /* [count], >= 0; 0: met exactly */
    double *gram;         /* [count][most] V V^T, upper triangle */
    double *system;       /* [count][most] U of S = U^T U */
    double *multiplier;   /* [count] y */
    /* of the evidence */
    int rank;               /* directions found */
    double *low;            /* [RANK][most] V V^T = low^T low */
    double *small;          /* [RANK][RANK] */
    double *diagonal;       /* [RANK] and neighbours, [RANK - 1], of low Sigma^-1 low^T made tridiagonal, */
    double *beside, *along; /* and low Sigma^-1 gap [RANK] turned along with it */
    double *scratch;        /* [most + 2 RANK] */
    double *weighted;       /* [most][WIDTH] of data: pose, low and gap over their deviations, */
    double *products;       /* [WIDTH][WIDTH] and products of these columns */
    double rigid_misfit;    /* gap^T Sigma^-1 gap, Sigma = R R^T + diag(variance) */
    double rigid_volume;    /* log |Sigma| */
    void *memory;
    sb_allocator allocator;
} regi_gauss;

/* Room for so many data and loads. SB_ERROR_MEMORY. */
REGI_API sb_result regi_gauss_create(int most, int most_loads, const sb_allocator *allocator, regi_gauss *gauss,
                                     sb_error *error);
REGI_API void regi_gauss_free(regi_gauss *gauss); /* zeros are fine */

/* Takes out of V what of the loads has resultants: V <- V (I - B^+ B). */
REGI_API void regi_gauss_bind(regi_gauss *gauss);
/* Takes the resultants out of loads c[loads]. */
REGI_API void regi_gauss_balance(const regi_gauss *gauss, double *c);
/* gram = V V^T. */
REGI_API void regi_gauss_multiply(regi_gauss *gauss);

/* ---- the posterior of the present scale and variances; gram is there ---- */
/* S and y. 0: S is not positive. */
REGI_API int regi_gauss_solve(regi_gauss *gauss);
/* r[count] <- S^-1 r. */
REGI_API void regi_gauss_apply_inverse(const regi_gauss *gauss, double *r);
/* r <- U^-T r: of length |r|^2 = r^T S^-1 r. */
REGI_API void regi_gauss_whiten(const regi_gauss *gauss, double *r);
/* The same for x[count][REGI_BLOCK_WIDTH], as many at once. */
REGI_API void regi_gauss_whiten_many(const regi_gauss *gauss, double *x);
/* c[loads], p[poses] that multipliers y[count] stand for. */
REGI_API void regi_gauss_explain(const regi_gauss *gauss, const double *y, double *c, double *p);
/* out[count] = V c + R p. */
REGI_API void regi_gauss_predict(const regi_gauss *gauss, const double *c, const double *p, double *out);
/* Turns draws of the prior c[loads] (balanced), p[poses] and of the data's noise e[count], which is overwritten, into
 * a draw of the posterior's errors (Matheron's rule). */
REGI_API void regi_gauss_condition(const regi_gauss *gauss, double *c, double *p, double *e);

/* ---- evidence; gram is there ---- */
/* low: the pivoted Cholesky factor of gram. */
REGI_API void regi_gauss_reduce(regi_gauss *gauss);
/* Makes low tridiagonal against the noise and pose of now. 0: it has none (something is not finite). */
REGI_API int regi_gauss_spectrum(regi_gauss *gauss);
/* log p(gap | scale), less a constant of the count; scale 0: no loads at all. */
REGI_API double regi_gauss_evidence(const regi_gauss *gauss, double scale);
/* The scale of a grid (67 values, a tenth of a decade apart, about what the gaps and gram suggest) with the most
 * evidence, and that. */
REGI_API double regi_gauss_best_scale(const regi_gauss *gauss, double *evidence);

/* ---- dense helpers; wide: what sbi_lanes_are_wide() said ---- */
/* Upper triangle of upper[n][stride] += rows^T rows of rows[count][stride]. */
REGI_API void regi_gauss_add_squares(int wide, double *upper, int n, const double *rows, int count, size_t stride);
/* Upper a[n][stride] = U^T U in place, rows below the diagonal untouched. Returns 0 at a pivot that is not positive. */
REGI_API int regi_gauss_cholesky(int wide, double *a, int n, size_t stride);
/* r[n] <- U^-1 U^-T r */
REGI_API void regi_gauss_substitute(const double *u, int n, size_t stride, double *r);

#endif /* REGI_GAUSS_H */
