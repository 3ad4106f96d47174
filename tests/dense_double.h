/* dense_double: small positive definite systems in doubles, also where sb_real is float. */
#ifndef DENSE_DOUBLE_H
#define DENSE_DOUBLE_H

#include <math.h>

/* Cholesky in place of the lower triangle of m[n][n]; 0 when the matrix is not positive definite. */
static inline int dense_factor(double *m, int n)
{
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            double sum = m[i * n + j];
            for (int k = 0; k < j; k++)
                sum -= m[i * n + k] * m[j * n + k];
            if (i == j && !(sum > 0))
                return 0;
            m[i * n + j] = i == j ? sqrt(sum) : sum / m[j * n + j];
        }
    return 1;
}

/* x[n] solves the factored system for b[n], which may be x. */
static inline void dense_solve(const double *m, int n, const double *b, double *x)
{
    for (int i = 0; i < n; i++) {
        x[i] = b[i];
        for (int k = 0; k < i; k++)
            x[i] -= m[i * n + k] * x[k];
        x[i] /= m[i * n + i];
    }
    for (int i = n; i-- > 0;) {
        for (int k = i + 1; k < n; k++)
            x[i] -= m[k * n + i] * x[k];
        x[i] /= m[i * n + i];
    }
}

#endif
