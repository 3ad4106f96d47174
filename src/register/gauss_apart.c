/* gauss_apart: how well some gaps are foretold by the others (Rasmussen, Williams 2006, 5.4.2, for groups). */
#include <string.h>

#include "gauss.h"

enum { REGI_GAUSS_ROWS = REGI_GAUSS_RANK + REGI_GAUSS_POSES };

static double regi_gauss_weight(const regi_gauss *g, double floor, int datum)
{
    return 1 / (g->variance[datum] > floor ? g->variance[datum] : floor);
}

/* small[rows][rows]: I + L D^-1 L^T of the rows of L, which are those of low, scaled, and of the pose; factored. */
static int regi_gauss_factor_rows(regi_gauss *g, double floor, int rows)
{
    size_t m = (size_t)g->most, stride = (size_t)rows;
    for (int k = 0; k < rows; k++) {
        for (int i = 0; i < g->count; i++)
            g->scratch[i] = g->apart[(size_t)k * m + (size_t)i] * regi_gauss_weight(g, floor, i);
        for (int l = k; l < rows; l++) {
            const double *other = g->apart + (size_t)l * m;
            double sum = k == l;
            for (int i = 0; i < g->count; i++)
                sum += g->scratch[i] * other[i];
            g->small[(size_t)k * stride + (size_t)l] = sum;
        }
    }
    return regi_gauss_cholesky(g->small, rows, stride);
}

/* apart <- U^-T L D^-1: S^-1 = D^-1 - apart^T apart. */
static void regi_gauss_whiten_rows(regi_gauss *g, double floor, int rows)
{
    size_t m = (size_t)g->most;
    for (int k = 0; k < rows; k++) {
        double *row = g->apart + (size_t)k * m, pivot = 1 / g->small[(size_t)k * (size_t)rows + (size_t)k];
        for (int j = 0; j < k; j++) {
            const double *before = g->apart + (size_t)j * m;
            double share = g->small[(size_t)j * (size_t)rows + (size_t)k];
            for (int i = 0; i < g->count; i++)
                row[i] -= share * before[i];
        }
        for (int i = 0; i < g->count; i++)
            row[i] *= pivot;
    }
    for (int k = 0; k < rows; k++)
        for (int i = 0; i < g->count; i++)
            g->apart[(size_t)k * m + (size_t)i] *= regi_gauss_weight(g, floor, i);
}

REGI_API int regi_gauss_set_apart(regi_gauss *g)
{
    size_t m = (size_t)g->most, bytes = (size_t)g->count * sizeof(double);
    int rows = g->rank + g->poses;
    double floor = regi_gauss_floor(g);
    for (int k = 0; k < g->rank; k++)
        for (int i = 0; i < g->count; i++)
            g->apart[(size_t)k * m + (size_t)i] = g->scale * g->low[(size_t)k * m + (size_t)i];
    for (int k = 0; k < g->poses; k++)
        memcpy(g->apart + (size_t)(g->rank + k) * m, g->pose + (size_t)k * m, bytes);
    if (!regi_gauss_factor_rows(g, floor, rows))
        return 0;
    regi_gauss_whiten_rows(g, floor, rows);
    for (int i = 0; i < g->count; i++)
        g->multiplier[i] = g->gap[i] * regi_gauss_weight(g, floor, i);
    for (int k = 0; k < rows; k++) {
        const double *row = g->apart + (size_t)k * m;
        double along = 0;
        for (int i = 0; i < g->count; i++)
            along += row[i] * g->gap[i];
        for (int i = 0; i < g->count; i++)
            g->multiplier[i] -= along * row[i];
    }
    return 1;
}

/* system[count][count]: the block of S^-1 of those left out, factored. */
static int regi_gauss_factor_block(regi_gauss *g, const int *left, int count)
{
    size_t m = (size_t)g->most;
    double floor = regi_gauss_floor(g);
    for (int p = 0; p < count; p++) {
        memset(g->system + (size_t)p * m, 0, (size_t)count * sizeof(double));
        g->system[(size_t)p * m + (size_t)p] = regi_gauss_weight(g, floor, left[p]);
    }
    for (int k = 0; k < g->rank + g->poses; k++) {
        for (int p = 0; p < count; p++)
            g->scratch[p] = g->apart[(size_t)k * m + (size_t)left[p]];
        for (int p = 0; p < count; p++)
            for (int q = p; q < count; q++)
                g->system[(size_t)p * m + (size_t)q] -= g->scratch[p] * g->scratch[q];
    }
    return regi_gauss_cholesky(g->system, count, m);
}

REGI_API int regi_gauss_foretell(regi_gauss *g, const int *left, int count, int told, double *density)
{
    size_t m = (size_t)g->most;
    double *off = g->scratch, *unit = g->scratch + g->most;
    if (!regi_gauss_factor_block(g, left, count))
        return 0;
    for (int p = 0; p < count; p++)
        off[p] = g->multiplier[left[p]];
    regi_gauss_substitute(g->system, count, m, off);
    for (int p = count - told; p < count; p++) {
        double variance = 0;
        memset(unit, 0, (size_t)count * sizeof(double));
        unit[p] = 1;
        for (int q = p; q < count; q++) { /* U^-T unit, which begins there */
            const double *row = g->system + (size_t)q * m;
            unit[q] /= row[q];
            for (int r = q + 1; r < count; r++)
                unit[r] -= unit[q] * row[r];
            variance += unit[q] * unit[q];
        }
        *density -= 0.5 * (sbi_dense_log(variance) + off[p] * off[p] / variance);
    }
    return 1;
}
