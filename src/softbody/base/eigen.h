/* eigen: eigenvalues and vectors of small dense symmetric matrices. Floor 0, internal. */
#ifndef SB_EIGEN_H
#define SB_EIGEN_H

#include "core.h"

/* Eigenvalues d[n] ascending and orthonormal eigenvectors, the rows of z[n][n], of the symmetric a[n][n], which is
 * overwritten; its lower triangle is read. scratch: [2 n]. Some 9 n^3 multiply-adds, the same bits everywhere. Returns
 * 0 when an entry is not finite. */
SBI_API int sbi_symmetric_eigen(double *a, int n, double *d, double *z, double *scratch);

/* The first third of that: a = Q T Q^T of the diagonal d[n] and its neighbours e[n - 1]; Q stays in a and scale[n - 1],
 * for sbi_symmetric_turn. scratch: [n]. */
SBI_API void sbi_symmetric_tridiagonalise(double *a, int n, double *d, double *e, double *scale, double *scratch);
/* x[n] <- Q^T x */
SBI_API void sbi_symmetric_turn(const double *a, int n, const double *scale, double *x);

#endif /* SB_EIGEN_H */
