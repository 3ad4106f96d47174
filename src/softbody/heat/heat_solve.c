/* heat_solve: conjugate gradients with an incomplete Cholesky factor on the matrix's own pattern, in double. One thread
 * does it all: a system of 10,000 nodes takes a few milliseconds, and bits depend on no thread. */
#include "heat_private.h"

#include <math.h>
#include <string.h>

/* ---- the factor ---- */

/* sum_j L_ij L_kj over columns j < k. */
static double sbi_heat_row_product(const sb_heat *heat, int i, int k)
{
    const int *columns = heat->columns;
    int p = heat->row_start[i], q = heat->row_start[k];
    double sum = 0;
    while (columns[p] < k && columns[q] < k) {
        if (columns[p] == columns[q])
            sum += heat->factor[p++] * heat->factor[q++];
        else if (columns[p] < columns[q])
            p++;
        else
            q++;
    }
    return sum;
}

/* L L^T ~ A with the diagonal times 1 + shift; 0: a pivot is not positive. Rows that are held are those of 1. */
static int sbi_heat_try_factor(sb_heat *heat, double shift)
{
    for (int i = 0; i < heat->node_count; i++) {
        int end = heat->diagonal[i];
        double pivot = heat->matrix[end] * (1 + shift);
        for (int p = heat->row_start[i]; p < end; p++) {
            int k = heat->columns[p];
            heat->factor[p] = 0;
            if (heat->held[i] || heat->held[k])
                continue;
            heat->factor[p] = (heat->matrix[p] - sbi_heat_row_product(heat, i, k)) / heat->factor[heat->diagonal[k]];
            pivot -= heat->factor[p] * heat->factor[p];
        }
        if (!heat->held[i] && !(pivot > 0))
            return 0;
        heat->factor[end] = heat->held[i] ? 1 : sqrt(pivot);
    }
    return 1;
}

static int sbi_heat_factor(sb_heat *heat)
{
    static const double shifts[6] = {0, 1e-3, 1e-2, 0.1, 1, 10}; /* Manteuffel 1980; the last are diagonal scaling */
    for (int k = 0; k < 6; k++)
        if (sbi_heat_try_factor(heat, shifts[k]))
            return 1;
    return 0;
}

/* z = (L L^T)^-1 r */
static void sbi_heat_smooth(const sb_heat *heat, const double *r, double *z)
{
    for (int i = 0; i < heat->node_count; i++) {
        double sum = heat->held[i] ? 0 : r[i];
        for (int p = heat->row_start[i]; p < heat->diagonal[i]; p++)
            sum -= heat->factor[p] * z[heat->columns[p]];
        z[i] = sum / heat->factor[heat->diagonal[i]];
    }
    for (int i = heat->node_count - 1; i >= 0; i--) {
        double value = z[i] / heat->factor[heat->diagonal[i]];
        z[i] = value;
        for (int p = heat->row_start[i]; p < heat->diagonal[i]; p++)
            z[heat->columns[p]] -= heat->factor[p] * value;
    }
}

/* ---- conjugate gradients ---- */

SBI_API double sbi_heat_dot(const sb_heat *heat, const double *a, const double *b)
{
    double sum = 0;
    for (int i = 0; i < heat->node_count; i++)
        if (!heat->held[i])
            sum += a[i] * b[i];
    return sum;
}

/* y = A x; x is 0 where held, and so is y. */
static void sbi_heat_multiply(const sb_heat *heat, const double *x, double *y)
{
    for (int i = 0; i < heat->node_count; i++) {
        double sum = 0;
        for (int q = heat->row_start[i]; q < heat->row_start[i + 1] && !heat->held[i]; q++)
            sum += heat->matrix[q] * x[heat->columns[q]];
        y[i] = sum;
    }
}

/* x += factor y, r -= factor A y */
static void sbi_heat_advance(sb_heat *heat, double factor, const double *y, const double *product)
{
    for (int i = 0; i < heat->node_count; i++) {
        heat->change[i] += factor * y[i];
        heat->residual[i] -= factor * product[i];
    }
}

/* The constant that takes the sum of the residual to 0, so that no heat is lost between rows. */
static void sbi_heat_close(sb_heat *heat)
{
    double left = 0, sum = 0;
    for (int i = 0; i < heat->node_count; i++)
        heat->direction[i] = heat->held[i] ? 0 : 1;
    sbi_heat_multiply(heat, heat->direction, heat->product);
    for (int i = 0; i < heat->node_count; i++)
        if (!heat->held[i]) {
            left += heat->residual[i];
            sum += heat->product[i];
        }
    if (sum > 0)
        sbi_heat_advance(heat, left / sum, heat->direction, heat->product);
}

SBI_API sb_result sbi_heat_solve(sb_heat *heat, double tolerance, int *iterations, double *work, sb_error *error)
{
    int n = heat->node_count;
    double goal, rho = 0;
    if (!sbi_heat_factor(heat))
        return sbi_fail(error, SB_ERROR_INDEFINITE, "the matrix of heat is not positive definite");
    *work = 0;
    memset(heat->change, 0, (size_t)n * sizeof *heat->change);
    goal = tolerance * sqrt(sbi_heat_dot(heat, heat->residual, heat->residual));
    for (int k = 0;; k++) {
        double left = sqrt(sbi_heat_dot(heat, heat->residual, heat->residual)), next, curvature;
        if (left <= goal)
            break;
        if (!(left <= (double)SB_REAL_MAX))
            return sbi_fail(error, SB_ERROR_DIVERGED, "the solution of heat is not finite");
        if (k == heat->def.max_iterations)
            return sbi_fail(error, SB_ERROR_NOT_CONVERGED, "heat left %g of its residual after %d iterations",
                            goal > 0 ? left / goal * tolerance : left, k);
        sbi_heat_smooth(heat, heat->residual, heat->smooth);
        next = sbi_heat_dot(heat, heat->residual, heat->smooth);
        for (int i = 0; i < n; i++)
            heat->direction[i] = heat->smooth[i] + (k ? next / rho * heat->direction[i] : 0);
        rho = next;
        sbi_heat_multiply(heat, heat->direction, heat->product);
        curvature = sbi_heat_dot(heat, heat->direction, heat->product);
        if (!(curvature > 0))
            return sbi_fail(error, SB_ERROR_INDEFINITE, "the matrix of heat is not positive definite");
        sbi_heat_advance(heat, rho / curvature, heat->direction, heat->product);
        *work += rho * (rho / curvature);
        ++*iterations;
    }
    sbi_heat_close(heat);
    return SB_OK;
}
