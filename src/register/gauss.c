/* gauss: see gauss.h. Inner loops add one row to another where they can, so that they need no reordering of sums to be
 * fast. */
#include "gauss.h"

#include <math.h>
#include <string.h>

#include "../softbody/base/eigen.h"
#include "block.h"

enum { REGI_GAUSS_SCALES = 67 }; /* of the grid */

static void regi_gauss_layout(regi_gauss *g, sbi_arena *arena)
{
    size_t m = (size_t)g->most, real = sizeof(double), rank = REGI_GAUSS_RANK;
    g->columns = (double *)sbi_arena_take(arena, (size_t)g->most_loads, m * real);
    g->resultants = (double *)sbi_arena_take(arena, (size_t)g->most_loads, REGI_GAUSS_EXACT * real);
    g->pose = (double *)sbi_arena_take(arena, m, REGI_GAUSS_POSES * real);
    g->gap = (double *)sbi_arena_take(arena, m, real);
    g->variance = (double *)sbi_arena_take(arena, m, real);
    g->gram = (double *)sbi_arena_take(arena, m, m * real);
    g->system = (double *)sbi_arena_take(arena, m, m * real);
    g->multiplier = (double *)sbi_arena_take(arena, m, real);
    g->low = (double *)sbi_arena_take(arena, m, rank * real);
    g->small = (double *)sbi_arena_take(arena, rank, rank * real);
    g->diagonal = (double *)sbi_arena_take(arena, rank, real);
    g->beside = (double *)sbi_arena_take(arena, rank, real);
    g->along = (double *)sbi_arena_take(arena, rank, real);
    g->scratch = (double *)sbi_arena_take(arena, m + 2 * rank, real);
    g->weighted = (double *)sbi_arena_take(arena, m, REGI_GAUSS_WIDTH * real);
    g->products = (double *)sbi_arena_take(arena, REGI_GAUSS_WIDTH, REGI_GAUSS_WIDTH * real);
}

REGI_API sb_result regi_gauss_create(int most, int most_loads, const sb_allocator *allocator, regi_gauss *gauss,
                                     sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    regi_gauss g;
    memset(&g, 0, sizeof g);
    g.most = most;
    g.most_loads = most_loads;
    g.wide = sbi_lanes_are_wide();
    if (allocator)
        g.allocator = *allocator;
    regi_gauss_layout(&g, &arena);
    g.memory = arena.overflow ? NULL : sbi_alloc_zeroed(&g.allocator, 1, arena.used);
    if (!g.memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d data of %d loads", most, most_loads);
    arena.base = (unsigned char *)g.memory;
    arena.used = 0;
    regi_gauss_layout(&g, &arena);
    *gauss = g;
    return SB_OK;
}

REGI_API void regi_gauss_free(regi_gauss *gauss)
{
    sbi_free(&gauss->allocator, gauss->memory);
    memset(gauss, 0, sizeof *gauss);
}

/* ---- dense ---- */

/* In four sums, none of which waits for another. */
static double regi_gauss_dot(const double *a, const double *b, int n)
{
    double sum[4] = {0, 0, 0, 0};
    int i = 0;
    for (; i + 4 <= n; i += 4)
        for (int k = 0; k < 4; k++)
            sum[k] += a[i + k] * b[i + k];
    for (; i < n; i++)
        sum[0] += a[i] * b[i];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

static void regi_gauss_add(double *SB_RESTRICT to, double factor, const double *SB_RESTRICT from, int n)
{
    for (int i = 0; i < n; i++)
        to[i] += factor * from[i];
}

/* Upper triangle of upper[n][stride] += factor * rows^T rows of rows[count][stride]. */
static void regi_gauss_square(int wide, double *upper, int n, double factor, const double *rows, int count,
                              size_t stride)
{
    enum { DEPTH = 64, SIDE = REGI_BLOCK_WIDTH }; /* rows that stay near */
    for (int k = 0; k < count; k += DEPTH)
        for (int i = 0; i < n; i += SIDE) {
            const double *at = rows + (size_t)k * stride + i;
            regi_block block = {NULL, NULL, 0, 0, 1, 0, 0};
            double corner[(int)SIDE * (int)SIDE], *to = upper + (size_t)i * stride + i;
            int side = sbi_min_int(SIDE, n - i);
            block.left = block.right = at;
            block.wide = wide;
            block.left_stride = block.right_step = stride;
            block.depth = sbi_min_int(DEPTH, count - k);
            memset(corner, 0, sizeof corner);
            regi_block_add(&block, side, side, factor, corner, SIDE);
            for (int r = 0; r < side; r++)
                regi_gauss_add(to + (size_t)r * stride + r, 1, corner + r * (int)SIDE + r, side - r);
            block.left += side;
            regi_block_add(&block, n - i - side, side, factor, to + side, stride);
        }
}

REGI_API void regi_gauss_add_squares(int wide, double *upper, int n, const double *rows, int count, size_t stride)
{
    regi_gauss_square(wide, upper, n, 1, rows, count, stride);
}

REGI_API int regi_gauss_cholesky(int wide, double *a, int n, size_t stride)
{
    enum { BLOCK = 32 };
    for (int first = 0; first < n; first += BLOCK) {
        int next = sbi_min_int(first + BLOCK, n);
        for (int k = first; k < next; k++) {
            double *row = a + (size_t)k * stride, scale;
            if (!(row[k] > 0))
                return 0;
            scale = 1 / sqrt(row[k]);
            for (int j = k; j < n; j++)
                row[j] *= scale;
            for (int i = k + 1; i < next; i++)
                regi_gauss_add(a + (size_t)i * stride + i, -row[i], row + i, n - i);
        }
        regi_gauss_square(wide, a + (size_t)next * stride + next, n - next, -1, a + (size_t)first * stride + next,
                          next - first, stride);
    }
    return 1;
}

/* r <- U^-T r */
static void regi_gauss_forward(const double *u, int n, size_t stride, double *r)
{
    for (int k = 0; k < n; k++) {
        const double *row = u + (size_t)k * stride;
        r[k] /= row[k];
        regi_gauss_add(r + k + 1, -r[k], row + k + 1, n - k - 1);
    }
}

/* r <- U^-1 r */
static void regi_gauss_backward(const double *u, int n, size_t stride, double *r)
{
    for (int k = n - 1; k >= 0; k--) {
        const double *row = u + (size_t)k * stride;
        r[k] = (r[k] - regi_gauss_dot(row + k + 1, r + k + 1, n - k - 1)) / row[k];
    }
}

REGI_API void regi_gauss_substitute(const double *u, int n, size_t stride, double *r)
{
    regi_gauss_forward(u, n, stride, r);
    regi_gauss_backward(u, n, stride, r);
}

/* ---- resultants ---- */

/* Makes the rows of B orthonormal; those that are sums of the ones before become 0. */
static void regi_gauss_orthogonalise(regi_gauss *g)
{
    for (int e = 0; e < g->exact; e++) {
        double *row = g->resultants + (size_t)e * (size_t)g->most_loads, before, after;
        before = sqrt(regi_gauss_dot(row, row, g->loads));
        for (int twice = 0; twice < 2; twice++)
            for (int k = 0; k < e; k++) {
                const double *other = g->resultants + (size_t)k * (size_t)g->most_loads;
                regi_gauss_add(row, -regi_gauss_dot(row, other, g->loads), other, g->loads);
            }
        after = sqrt(regi_gauss_dot(row, row, g->loads));
        for (int b = 0; b < g->loads; b++)
            row[b] = after > 1e-9 * before ? row[b] / after : 0;
    }
}

REGI_API void regi_gauss_bind(regi_gauss *g)
{
    size_t m = (size_t)g->most;
    regi_gauss_orthogonalise(g);
    for (int e = 0; e < g->exact; e++) {
        const double *row = g->resultants + (size_t)e * (size_t)g->most_loads;
        memset(g->scratch, 0, (size_t)g->count * sizeof(double));
        for (int b = 0; b < g->loads; b++)
            regi_gauss_add(g->scratch, row[b], g->columns + (size_t)b * m, g->count);
        for (int b = 0; b < g->loads; b++)
            regi_gauss_add(g->columns + (size_t)b * m, -row[b], g->scratch, g->count);
    }
}

REGI_API void regi_gauss_balance(const regi_gauss *g, double *c)
{
    for (int e = 0; e < g->exact; e++) {
        const double *row = g->resultants + (size_t)e * (size_t)g->most_loads;
        regi_gauss_add(c, -regi_gauss_dot(row, c, g->loads), row, g->loads);
    }
}

REGI_API void regi_gauss_multiply(regi_gauss *g)
{
    size_t m = (size_t)g->most;
    for (int i = 0; i < g->count; i++)
        memset(g->gram + (size_t)i * m, 0, (size_t)g->count * sizeof(double));
    regi_gauss_add_squares(g->wide, g->gram, g->count, g->columns, g->loads, m);
}

/* ---- posterior ---- */

REGI_API int regi_gauss_solve(regi_gauss *g)
{
    size_t m = (size_t)g->most;
    for (int i = 0; i < g->count; i++) {
        double *row = g->system + (size_t)i * m;
        for (int j = i; j < g->count; j++)
            row[j] = g->scale * g->scale * g->gram[(size_t)i * m + (size_t)j];
        row[i] += g->variance[i];
    }
    regi_gauss_add_squares(g->wide, g->system, g->count, g->pose, g->poses, m);
    if (!regi_gauss_cholesky(g->wide, g->system, g->count, m))
        return 0;
    memcpy(g->multiplier, g->gap, (size_t)g->count * sizeof(double));
    regi_gauss_apply_inverse(g, g->multiplier);
    return 1;
}

REGI_API void regi_gauss_whiten(const regi_gauss *g, double *r)
{
    regi_gauss_forward(g->system, g->count, (size_t)g->most, r);
}

REGI_API void regi_gauss_whiten_many(const regi_gauss *g, double *x)
{
    regi_block_forward(g->wide, g->system, g->count, (size_t)g->most, x);
}

REGI_API void regi_gauss_apply_inverse(const regi_gauss *g, double *r)
{
    regi_gauss_substitute(g->system, g->count, (size_t)g->most, r);
}

REGI_API void regi_gauss_explain(const regi_gauss *g, const double *y, double *c, double *p)
{
    for (int b = 0; b < g->loads; b++)
        c[b] = g->scale * g->scale * regi_gauss_dot(g->columns + (size_t)b * (size_t)g->most, y, g->count);
    for (int k = 0; k < g->poses; k++)
        p[k] = regi_gauss_dot(g->pose + (size_t)k * (size_t)g->most, y, g->count);
}

REGI_API void regi_gauss_predict(const regi_gauss *g, const double *c, const double *p, double *out)
{
    memset(out, 0, (size_t)g->count * sizeof(double));
    for (int b = 0; b < g->loads; b++)
        regi_gauss_add(out, c[b], g->columns + (size_t)b * (size_t)g->most, g->count);
    for (int k = 0; k < g->poses; k++)
        regi_gauss_add(out, p[k], g->pose + (size_t)k * (size_t)g->most, g->count);
}

REGI_API void regi_gauss_condition(const regi_gauss *g, double *c, double *p, double *e)
{
    size_t m = (size_t)g->most;
    for (int b = 0; b < g->loads; b++)
        regi_gauss_add(e, c[b], g->columns + (size_t)b * m, g->count);
    for (int k = 0; k < g->poses; k++)
        regi_gauss_add(e, p[k], g->pose + (size_t)k * m, g->count);
    regi_gauss_apply_inverse(g, e);
    for (int b = 0; b < g->loads; b++)
        c[b] -= g->scale * g->scale * regi_gauss_dot(g->columns + (size_t)b * m, e, g->count);
    for (int k = 0; k < g->poses; k++)
        p[k] -= regi_gauss_dot(g->pose + (size_t)k * m, e, g->count);
}

/* ---- evidence ---- */

REGI_API void regi_gauss_reduce(regi_gauss *g)
{
    size_t m = (size_t)g->most;
    double first = 0, *left = g->scratch; /* diagonal of what is left of gram */
    for (int i = 0; i < g->count; i++) {
        left[i] = g->gram[(size_t)i * m + (size_t)i];
        first = left[i] > first ? left[i] : first;
    }
    for (g->rank = 0; g->rank < REGI_GAUSS_RANK && g->rank < g->count; g->rank++) {
        double *row = g->low + (size_t)g->rank * m, scale;
        int at = 0;
        for (int i = 1; i < g->count; i++)
            at = left[i] > left[at] ? i : at;
        if (!(left[at] > 1e-8 * first)) /* a ten-thousandth of the motion that the prior holds for likely */
            break;
        for (int i = 0; i < g->count; i++)
            row[i] = i < at ? g->gram[(size_t)i * m + (size_t)at] : g->gram[(size_t)at * m + (size_t)i];
        for (int k = 0; k < g->rank; k++)
            regi_gauss_add(row, -g->low[(size_t)k * m + (size_t)at], g->low + (size_t)k * m, g->count);
        scale = 1 / sqrt(left[at]);
        for (int i = 0; i < g->count; i++) {
            row[i] *= scale;
            left[i] -= row[i] * row[i];
        }
        left[at] = 0;
    }
}

/* The variance that stands for one in the evidence: data that are met exactly count as met to a thousandth of the least
 * deviation of the others. */
static double regi_gauss_floor(const regi_gauss *g)
{
    double least = 0;
    for (int i = 0; i < g->count; i++)
        if (g->variance[i] > 0 && (!(least > 0) || g->variance[i] < least))
            least = g->variance[i];
    return least > 0 ? 1e-6 * least : 1e-300;
}

/* weighted: a row of each datum over its deviation, of the pose's columns, of low, and of the gap. Returns
 * log |diag(variance)|. */
static double regi_gauss_weigh(regi_gauss *g)
{
    size_t m = (size_t)g->most;
    double floor = regi_gauss_floor(g), volume = 0;
    for (int i = 0; i < g->count; i++) {
        double variance = g->variance[i] > floor ? g->variance[i] : floor, sure = 1 / sqrt(variance);
        double *to = g->weighted + (size_t)i * REGI_GAUSS_WIDTH;
        for (int k = 0; k < g->poses; k++)
            *to++ = sure * g->pose[(size_t)k * m + (size_t)i];
        for (int a = 0; a < g->rank; a++)
            *to++ = sure * g->low[(size_t)a * m + (size_t)i];
        *to = sure * g->gap[i];
        volume += sbi_dense_log(variance);
    }
    return volume;
}

/* products, upper triangle: those of weighted's columns, with Sigma^-1 between them once the pose's are eliminated:
 * Sigma^-1 = D^-1 - D^-1 R (I + R^T D^-1 R)^-1 R^T D^-1, D = diag(variance). *volume: log |I + R^T D^-1 R|. 0: they are
 * not finite. */
static int regi_gauss_free_of_pose(regi_gauss *g, double *volume)
{
    int n = g->poses + g->rank + 1;
    memset(g->products, 0, (size_t)n * REGI_GAUSS_WIDTH * sizeof(double));
    regi_gauss_add_squares(g->wide, g->products, n, g->weighted, g->count, REGI_GAUSS_WIDTH);
    *volume = 0;
    for (int k = 0; k < g->poses; k++) {
        double *row = g->products + (size_t)k * REGI_GAUSS_WIDTH, pivot = 1 + row[k];
        if (!(pivot > 0))
            return 0;
        *volume += sbi_dense_log(pivot);
        for (int i = k + 1; i < n; i++)
            regi_gauss_add(g->products + (size_t)i * REGI_GAUSS_WIDTH + i, -row[i] / pivot, row + i, n - i);
    }
    return 1;
}

REGI_API int regi_gauss_spectrum(regi_gauss *g)
{
    const double *free_of_pose = g->products + (size_t)g->poses * REGI_GAUSS_WIDTH + g->poses;
    double variances = regi_gauss_weigh(g), volume;
    if (!regi_gauss_free_of_pose(g, &volume))
        return 0;
    g->rigid_misfit = free_of_pose[(size_t)g->rank * REGI_GAUSS_WIDTH + (size_t)g->rank];
    g->rigid_volume = variances + volume;
    for (int a = 0; a < g->rank; a++) {
        g->along[a] = free_of_pose[(size_t)a * REGI_GAUSS_WIDTH + (size_t)g->rank];
        for (int b = 0; b <= a; b++)
            g->small[(size_t)a * (size_t)g->rank + (size_t)b] = free_of_pose[(size_t)b * REGI_GAUSS_WIDTH + (size_t)a];
    }
    if (g->rank > 0) {
        sbi_symmetric_tridiagonalise(g->small, g->rank, g->diagonal, g->beside, g->scratch, g->scratch + g->rank);
        sbi_symmetric_turn(g->small, g->rank, g->scratch, g->along);
    }
    return fabs(g->rigid_misfit) < 1e300 && (g->rank == 0 || fabs(g->diagonal[g->rank - 1]) < 1e300); /* not NaN */
}

/* |I + scale^2 T| and b^T (I + scale^2 T)^-1 b of the tridiagonal T, by elimination. */
REGI_API double regi_gauss_evidence(const regi_gauss *g, double scale)
{
    double square = scale * scale, misfit = g->rigid_misfit, volume = g->rigid_volume, pivot = 1, part = 0;
    for (int k = 0; k < g->rank; k++) {
        double beside = k > 0 ? square * g->beside[k - 1] : 0, ratio = beside / pivot;
        pivot = 1 + square * g->diagonal[k] - ratio * beside;
        pivot = pivot > 1 ? pivot : 1; /* T has no negative eigenvalues but for rounding */
        part = g->along[k] - ratio * part;
        misfit -= square * part * part / pivot;
        volume += sbi_dense_log(pivot);
    }
    return -0.5 * (misfit + volume);
}

REGI_API double regi_gauss_best_scale(const regi_gauss *g, double *evidence)
{
    double gaps = 0, trace = 0, best = 0, most = 0, middle;
    for (int i = 0; i < g->count; i++) {
        gaps += g->gap[i] * g->gap[i];
        trace += g->gram[(size_t)i * (size_t)g->most + (size_t)i];
    }
    middle = trace > 0 && gaps > 0 ? sqrt(gaps / trace) : 1;
    for (int k = 0; k < REGI_GAUSS_SCALES; k++) {
        double scale = middle * sbi_dense_exp(2.302585092994046 * (k - REGI_GAUSS_SCALES / 2) / 10);
        double found = regi_gauss_evidence(g, scale);
        if (k == 0 || found > most) {
            most = found;
            best = scale;
        }
    }
    *evidence = most;
    return best;
}
