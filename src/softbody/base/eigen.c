/* eigen: Householder, then QL with implicit shifts (Wilkinson and Reinsch 1971). */
#include "eigen.h"

#include <math.h>
#include <string.h>

/* w[from .. n) = a v for the symmetric a[n][n], rows and columns from `from` on: each entry of the lower triangle once.
 */
static void sbi_eigen_multiply(const double *a, int n, int from, const double *v, double *w)
{
    for (int i = from; i < n; i++) {
        const double *row = a + (size_t)i * (size_t)n;
        double sum = 0, own = v[i];
        for (int j = from; j < i; j++) {
            sum += row[j] * v[j];
            w[j] += row[j] * own;
        }
        w[i] = sum + row[i] * own;
    }
}

/* One reflection: of column k below the diagonal. v[n], w[n] are scratch. */
static void sbi_eigen_reflect(double *a, int n, int k, double scale, double *v, double *w)
{
    double along = 0;
    for (int i = k + 1; i < n; i++)
        v[i] = a[i * n + k];
    sbi_eigen_multiply(a, n, k + 1, v, w);
    for (int i = k + 1; i < n; i++) {
        w[i] *= scale;
        along += w[i] * v[i];
    }
    for (int i = k + 1; i < n; i++)
        w[i] -= 0.5 * scale * along * v[i];
    for (int i = k + 1; i < n; i++)
        for (int j = k + 1; j <= i; j++)
            a[i * n + j] -= v[i] * w[j] + w[i] * v[j];
}

SBI_API void sbi_symmetric_tridiagonalise(double *a, int n, double *d, double *e, double *scale, double *scratch)
{
    for (int k = 0; k < n - 1; k++) {
        double norm = 0;
        for (int i = k + 1; i < n; i++)
            norm += a[i * n + k] * a[i * n + k];
        norm = sqrt(norm);
        scale[k] = 0;
        e[k] = a[(k + 1) * n + k];
        if (k == n - 2 || !(norm > 0))
            continue;
        e[k] = e[k] > 0 ? -norm : norm;
        a[(k + 1) * n + k] -= e[k];
        scale[k] = 1 / (-e[k] * a[(k + 1) * n + k]);
        sbi_eigen_reflect(a, n, k, scale[k], scratch, d); /* d is free so far */
    }
    for (int i = 0; i < n; i++)
        d[i] = a[i * n + i];
}

SBI_API void sbi_symmetric_turn(const double *a, int n, const double *scale, double *x)
{
    for (int k = 0; k < n - 2; k++) {
        double sum = 0;
        for (int i = k + 1; i < n; i++)
            sum += a[i * n + k] * x[i];
        for (int i = k + 1; i < n; i++)
            x[i] -= scale[k] * sum * a[i * n + k];
    }
}

/* Row j of z: the reflections applied to unit vector j. */
static void sbi_eigen_accumulate(const double *a, int n, const double *scale, double *z)
{
    memset(z, 0, (size_t)n * (size_t)n * sizeof *z);
    for (int j = 0; j < n; j++) {
        double *row = z + (size_t)j * (size_t)n;
        row[j] = 1;
        for (int k = n - 3; k >= 0; k--) {
            double sum = 0;
            for (int i = k + 1; i < n; i++)
                sum += a[i * n + k] * row[i];
            for (int i = k + 1; i < n; i++)
                row[i] -= scale[k] * sum * a[i * n + k];
        }
    }
}

/* One sweep on the unreduced part l .. m of the tridiagonal matrix; turns the rows of z along. */
static void sbi_eigen_ql_sweep(double *d, double *e, int l, int m, double *z, int n)
{
    double g = (d[l + 1] - d[l]) / (2 * e[l]), r = sqrt(g * g + 1), s = 1, c = 1, p = 0;
    g = d[m] - d[l] + e[l] / (g + (g < 0 ? -r : r));
    for (int i = m - 1; i >= l; i--) {
        double f = s * e[i], b = c * e[i], *low = z + (size_t)i * (size_t)n, *high = low + n;
        r = sqrt(f * f + g * g);
        e[i + 1] = r;
        if (!(r > 0)) { /* the matrix falls apart here: the next sweep finds that */
            d[i + 1] -= p;
            e[m] = 0;
            return;
        }
        s = f / r;
        c = g / r;
        g = d[i + 1] - p;
        r = (d[i] - g) * s + 2 * c * b;
        p = s * r;
        d[i + 1] = g + p;
        g = c * r - b;
        for (int k = 0; k < n; k++) {
            f = high[k];
            high[k] = s * low[k] + c * f;
            low[k] = c * low[k] - s * f;
        }
    }
    d[l] -= p;
    e[l] = g;
    e[m] = 0;
}

SBI_API int sbi_symmetric_eigen(double *a, int n, double *d, double *z, double *scratch)
{
    double *e = scratch, *scale = scratch + n;
    sbi_symmetric_tridiagonalise(a, n, d, e, scale, z);
    sbi_eigen_accumulate(a, n, scale, z);
    e[n - 1] = 0;
    for (int l = 0, sweeps = 0; l < n;) {
        int m = l;
        while (m < n - 1 && !(fabs(e[m]) <= 2.2e-16 * (fabs(d[m]) + fabs(d[m + 1]))))
            m++;
        if (m == l) {
            l++;
            sweeps = 0;
            continue;
        }
        if (++sweeps > 60) /* two are usual; NaN never ends */
            return 0;
        sbi_eigen_ql_sweep(d, e, l, m, z, n);
    }
    for (int i = 0; i < n; i++) { /* few are out of order: insertion */
        int least = i;
        for (int j = i + 1; j < n; j++)
            if (d[j] < d[least])
                least = j;
        if (least != i) {
            double value = d[i];
            d[i] = d[least];
            d[least] = value;
            for (int k = 0; k < n; k++) {
                value = z[(size_t)i * (size_t)n + (size_t)k];
                z[(size_t)i * (size_t)n + (size_t)k] = z[(size_t)least * (size_t)n + (size_t)k];
                z[(size_t)least * (size_t)n + (size_t)k] = value;
            }
        }
    }
    return 1;
}
