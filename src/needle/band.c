/* band: see band.h. */
#include "band.h"

#include "real3.h"

/* Row i holds L_ik D_k while it is being made, so that one product a term is enough; then it is scaled to L. */
NDLI_API int ndli_band_factor(double *a, int n, int width, double least)
{
    for (int i = 0; i < n; i++) {
        double *row = a + (size_t)i * (size_t)(width + 1) + width - i, diagonal = row[i], pivot = diagonal;
        int first = sbi_max_int(0, i - width);
        for (int j = first; j < i; j++) {
            const double *other = a + (size_t)j * (size_t)(width + 1) + width - j;
            double sum = row[j];
            for (int k = sbi_max_int(first, j - width); k < j; k++)
                sum -= row[k] * other[k];
            row[j] = sum;
        }
        for (int j = first; j < i; j++) {
            double scaled = row[j] * a[(size_t)j * (size_t)(width + 1) + (size_t)width];
            pivot -= row[j] * scaled;
            row[j] = scaled;
        }
        if (!(pivot > least * diagonal) || !ndli_is_finite(pivot))
            return i;
        row[i] = 1 / pivot;
    }
    return -1;
}

NDLI_API void ndli_band_solve(const double *a, int n, int width, double *b)
{
    for (int i = 0; i < n; i++) {
        const double *row = a + (size_t)i * (size_t)(width + 1) + width - i;
        for (int j = sbi_max_int(0, i - width); j < i; j++)
            b[i] -= row[j] * b[j];
    }
    for (int i = n - 1; i >= 0; i--) {
        const double *row = a + (size_t)i * (size_t)(width + 1) + width - i;
        b[i] *= row[i];
        for (int k = i + 1; k <= sbi_min_int(n - 1, i + width); k++)
            b[i] -= a[(size_t)k * (size_t)(width + 1) + (size_t)(width - k + i)] * b[k];
    }
}
