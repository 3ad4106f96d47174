/* band: symmetric positive definite systems of small bandwidth, as chains of nodes make them. Floor 6, internal. */
#ifndef NDL_BAND_H
#define NDL_BAND_H

#include "api.h"

/* A symmetric n x n matrix whose entry (i, j) is 0 for |i - j| > width, by rows of its lower half: (i, j), i - width <=
 * j <= i, at a[i * (width + 1) + j - i + width]. The places before column 0 are never read. */
#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* A = L D L^T in place (L unit lower, 1/D on the diagonal). Returns -1, or the first row whose pivot is not above
 * `least` times its diagonal entry: the matrix is then not safely positive definite, and *a is spoilt. No allocation,
 * n width^2 / 2 multiply-adds. */
NDLI_API int ndli_band_factor(double *a, int n, int width, double least);
/* b = A^-1 b for a factored A. */
NDLI_API void ndli_band_solve(const double *a, int n, int width, double *b);
#endif

#endif /* NDL_BAND_H */
