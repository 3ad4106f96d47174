/* cpd_kernel: the factor of the Gaussian kernel, and the system for the deformation.
 *
 * With G = L L^T the system of the paper, (P G + lambda s2) W = r with r = P X - P Y, is met by T = Y + L c with
 * (L^T P L + lambda s2) c = L^T r: symmetric and positive definite, and points without partners (P = 0) need no
 * division. c = L^T W, so |c|^2 is the regularising term tr(W^T G W). */
#include "cpd_private.h"

#include <string.h>

enum {
    REGI_CPD_FIRST = 64,  /* columns that are made room for at first */
    REGI_CPD_SLICE = 512, /* rows of L that are weighted at a time: all columns of a slice stay in the cache */
    REGI_CPD_STRIP = 32,  /* rows of the system per task, and per step of its factorisation */
    REGI_CPD_FOUR = 4     /* lanes of a sum of products */
};

static double regi_cpd_gauss(const double a[3], double x, double y, double z, double inverse)
{
    double dx = a[0] - x, dy = a[1] - y, dz = a[2] - z;
    return sbi_dense_exp(-(dx * dx + dy * dy + dz * dz) * inverse);
}

static double regi_cpd_not_below_0(double x) { return x > 0 ? x : 0.0; }

/* sum a_i b_i; count is a multiple of REGI_CPD_FOUR. */
static double regi_cpd_dot(const double *a, const double *b, size_t count)
{
    double sum[REGI_CPD_FOUR] = {0, 0, 0, 0};
    for (size_t i = 0; i < count; i += REGI_CPD_FOUR)
        for (int l = 0; l < REGI_CPD_FOUR; l++)
            sum[l] += a[i + (size_t)l] * b[i + (size_t)l];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* out += s a over whole blocks. */
static void regi_cpd_add(double *SB_RESTRICT out, double s, const double *SB_RESTRICT a, size_t count)
{
    for (size_t i = 0; i < count; i += REGI_CPD_LANES)
        for (int l = 0; l < REGI_CPD_LANES; l++)
            out[i + (size_t)l] += s * a[i + (size_t)l];
}

/* ---- factor ---- */

REGI_API void regi_cpd_kernel_free(regi_cpd_kernel *kernel)
{
    sbi_free(&kernel->allocator, kernel->columns);
    sbi_free(&kernel->allocator, kernel->pivots);
    sbi_free(&kernel->allocator, kernel->diagonal);
    sbi_free(&kernel->allocator, kernel->system);
    sbi_free(&kernel->allocator, kernel->scaled);
    sbi_free(&kernel->allocator, kernel->weights[0]);
}

static int regi_cpd_grow(regi_cpd_kernel *kernel, int capacity)
{
    size_t old = (size_t)kernel->rank * kernel->rows;
    double *columns = kernel->rows <= SIZE_MAX / sizeof(double)
                          ? (double *)sbi_alloc(&kernel->allocator, (size_t)capacity, kernel->rows * sizeof(double))
                          : NULL;
    int *pivots = (int *)sbi_alloc(&kernel->allocator, (size_t)capacity, sizeof(int));
    if (!columns || !pivots) {
        sbi_free(&kernel->allocator, columns);
        sbi_free(&kernel->allocator, pivots);
        return 0;
    }
    if (old > 0) {
        memcpy(columns, kernel->columns, old * sizeof(double));
        memcpy(pivots, kernel->pivots, (size_t)kernel->rank * sizeof(int));
    }
    sbi_free(&kernel->allocator, kernel->columns);
    sbi_free(&kernel->allocator, kernel->pivots);
    kernel->columns = columns;
    kernel->pivots = pivots;
    kernel->capacity = capacity;
    return 1;
}

/* The row with the largest remaining diagonal entry above tolerance, of equal ones the first; -1: none. */
static int regi_cpd_next_pivot(const regi_cpd_kernel *kernel, int count, double tolerance)
{
    double most = tolerance;
    int pivot = -1;
    for (int i = 0; i < count; i++)
        if (kernel->diagonal[i] > most) {
            most = kernel->diagonal[i];
            pivot = i;
        }
    return pivot;
}

/* Column `rank` of the factor: what the columns before leave of the pivot's column of G. */
static void regi_cpd_add_column(regi_cpd_kernel *kernel, const regi_cpd_cloud *source, int pivot)
{
    const regi_cpd_block *home = source->points + pivot / REGI_CPD_LANES;
    double *column = kernel->columns + (size_t)kernel->rank * kernel->rows;
    double root = sqrt(kernel->diagonal[pivot]), at[3];
    at[0] = home->x[pivot % REGI_CPD_LANES], at[1] = home->y[pivot % REGI_CPD_LANES];
    at[2] = home->z[pivot % REGI_CPD_LANES];
    for (int b = 0; b < source->blocks; b++)
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            const regi_cpd_block *p = source->points + b;
            column[(size_t)b * REGI_CPD_LANES + (size_t)l] = regi_cpd_gauss(at, p->x[l], p->y[l], p->z[l],
                                                                            kernel->inverse);
        }
    for (int j = 0; j < kernel->rank; j++) {
        const double *before = kernel->columns + (size_t)j * kernel->rows;
        regi_cpd_add(column, -before[pivot], before, kernel->rows);
    }
    for (size_t i = 0; i < kernel->rows; i++)
        column[i] = i < (size_t)source->count ? column[i] / root : 0.0;
    for (int i = 0; i < source->count; i++)
        if (kernel->diagonal[i] >= 0)
            kernel->diagonal[i] = regi_cpd_not_below_0(kernel->diagonal[i] - column[i] * column[i]);
    for (int j = 0; j < kernel->rank; j++)
        column[kernel->pivots[j]] = 0; /* but for rounding it is */
    column[pivot] = root;
    kernel->diagonal[pivot] = -1;
    kernel->pivots[kernel->rank++] = pivot;
}

/* Memory for the systems of a kernel of known rank. */
static int regi_cpd_kernel_room(regi_cpd_kernel *kernel)
{
    size_t rank = (size_t)kernel->rank, stride = (rank + REGI_CPD_FOUR - 1) / REGI_CPD_FOUR * REGI_CPD_FOUR;
    kernel->stride = stride;
    kernel->system = (double *)sbi_alloc_zeroed(&kernel->allocator, rank, stride * sizeof(double));
    kernel->scaled = (double *)sbi_alloc(&kernel->allocator, rank, REGI_CPD_SLICE * sizeof(double));
    kernel->weights[0] = (double *)sbi_alloc_zeroed(&kernel->allocator, 3 * stride, sizeof(double));
    if (!kernel->system || !kernel->scaled || !kernel->weights[0])
        return 0;
    kernel->weights[1] = kernel->weights[0] + stride;
    kernel->weights[2] = kernel->weights[1] + stride;
    return 1;
}

REGI_API sb_result regi_cpd_kernel_create(const regi_cpd_cloud *source, double beta, double tolerance, int max_rank,
                                          const sb_allocator *allocator, regi_cpd_kernel *kernel, sb_error *error)
{
    int most = sbi_min_int(max_rank, source->count), pivot = 0, fits;
    memset(kernel, 0, sizeof *kernel);
    kernel->allocator = *allocator;
    kernel->rows = (size_t)source->blocks * REGI_CPD_LANES;
    kernel->inverse = 1 / (2 * beta * beta);
    kernel->diagonal = (double *)sbi_alloc(allocator, kernel->rows, sizeof(double));
    fits = kernel->diagonal != NULL;
    for (size_t i = 0; fits && i < kernel->rows; i++)
        kernel->diagonal[i] = 1;
    while (fits && kernel->rank < most && pivot >= 0) {
        if (kernel->rank == kernel->capacity)
            fits = regi_cpd_grow(kernel, kernel->rank > most / 2 ? most
                                         : kernel->rank > 0      ? 2 * kernel->rank
                                                                 : sbi_min_int(most, REGI_CPD_FIRST));
        pivot = fits ? regi_cpd_next_pivot(kernel, source->count, tolerance) : -1;
        if (pivot >= 0)
            regi_cpd_add_column(kernel, source, pivot);
    }
    if (fits && regi_cpd_kernel_room(kernel))
        return SB_OK;
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d columns of the kernel of %d points", kernel->rank + 1,
                    source->count);
}

/* ---- system ---- */

/* Products of rows a, a2 with rows b, b2 over `count` entries, a multiple of REGI_CPD_FOUR. */
static void regi_cpd_tile(const double *SB_RESTRICT a, const double *SB_RESTRICT a2, const double *SB_RESTRICT b,
                          const double *SB_RESTRICT b2, size_t count, double out[4])
{
    double s[4][REGI_CPD_FOUR];
    for (int l = 0; l < REGI_CPD_FOUR; l++)
        s[0][l] = s[1][l] = s[2][l] = s[3][l] = 0;
    for (size_t i = 0; i < count; i += REGI_CPD_FOUR)
        for (int l = 0; l < REGI_CPD_FOUR; l++) {
            double p = a[i + (size_t)l], p2 = a2[i + (size_t)l], q = b[i + (size_t)l], q2 = b2[i + (size_t)l];
            s[0][l] += p * q;
            s[1][l] += p * q2;
            s[2][l] += p2 * q;
            s[3][l] += p2 * q2;
        }
    for (int k = 0; k < 4; k++)
        out[k] = (s[k][0] + s[k][1]) + (s[k][2] + s[k][3]);
}

/* c[i][j] += sign * row i . row j for i in [first, last), j in [from, to) with j <= i; rows of a lie `stride` apart;
 * first and from are even. */
static void regi_cpd_rows(double *c, size_t c_stride, const double *a, size_t stride, size_t count, double sign,
                          int first, int last, int from, int to)
{
    for (int i = first; i < last; i += 2) {
        int i2 = sbi_min_int(i + 1, last - 1), end = sbi_min_int(to, i2 + 1);
        for (int j = from; j < end; j += 2) {
            int j2 = sbi_min_int(j + 1, end - 1);
            double t[4], *row = c + (size_t)i * c_stride, *row2 = c + (size_t)i2 * c_stride;
            regi_cpd_tile(a + (size_t)i * stride, a + (size_t)i2 * stride, a + (size_t)j * stride,
                          a + (size_t)j2 * stride, count, t);
            row[j] += sign * t[0];
            if (j2 > j && j2 <= i)
                row[j2] += sign * t[1];
            if (i2 > i) {
                row2[j] += sign * t[2];
                if (j2 > j)
                    row2[j2] += sign * t[3];
            }
        }
    }
}

typedef struct regi_cpd_strips {
    regi_cpd_kernel *kernel;
    size_t count; /* rows of the slice */
} regi_cpd_strips;

static void regi_cpd_add_strip(void *user, int index)
{
    const regi_cpd_strips *strips = (const regi_cpd_strips *)user;
    regi_cpd_kernel *kernel = strips->kernel;
    int first = index * REGI_CPD_STRIP, last = sbi_min_int(first + REGI_CPD_STRIP, kernel->rank);
    regi_cpd_rows(kernel->system, kernel->stride, kernel->scaled, REGI_CPD_SLICE, strips->count, 1, first, last, 0,
                  last);
}

/* The lower half of L^T P L + ridge. */
static void regi_cpd_assemble(regi_cpd_kernel *kernel, const double *p, double ridge, const sb_jobs *jobs)
{
    regi_cpd_strips strips;
    double root[REGI_CPD_SLICE];
    int rank = kernel->rank;
    strips.kernel = kernel;
    memset(kernel->system, 0, (size_t)rank * kernel->stride * sizeof(double));
    for (size_t begin = 0; begin < kernel->rows; begin += REGI_CPD_SLICE) {
        strips.count = kernel->rows - begin < REGI_CPD_SLICE ? kernel->rows - begin : (size_t)REGI_CPD_SLICE;
        for (size_t i = 0; i < strips.count; i++)
            root[i] = sqrt(p[begin + i]);
        for (int k = 0; k < rank; k++) {
            const double *column = kernel->columns + (size_t)k * kernel->rows + begin;
            double *scaled = kernel->scaled + (size_t)k * REGI_CPD_SLICE;
            for (size_t i = 0; i < strips.count; i++)
                scaled[i] = root[i] * column[i];
        }
        sbi_run(jobs, regi_cpd_add_strip, &strips, (rank + REGI_CPD_STRIP - 1) / REGI_CPD_STRIP);
    }
    for (int k = 0; k < rank; k++)
        kernel->system[(size_t)k * kernel->stride + (size_t)k] += ridge;
}

/* Row i of the factor between columns from and to; rows up to i are done, and the sums with columns before `from` are
 * subtracted. The ridge keeps every pivot above 0: at least that much is left of it. */
static void regi_cpd_finish_row(double *a, size_t stride, int i, int from, int to, double ridge)
{
    double *row = a + (size_t)i * stride;
    for (int j = from; j < to && j <= i; j++) {
        const double *other = a + (size_t)j * stride;
        double sum = row[j];
        for (int k = from; k < j; k++)
            sum -= row[k] * other[k];
        row[j] = j < i ? sum / other[j] : sqrt(sum > ridge ? sum : ridge);
    }
}

REGI_API void regi_cpd_factor(double *a, int n, size_t stride, double ridge)
{
    for (int from = 0; from < n; from += REGI_CPD_STRIP) {
        int to = sbi_min_int(from + REGI_CPD_STRIP, n);
        for (int first = from; first < n; first += REGI_CPD_STRIP)
            regi_cpd_rows(a, stride, a, stride, (size_t)from, -1, first, sbi_min_int(first + REGI_CPD_STRIP, n), from,
                          to);
        for (int i = from; i < n; i++)
            regi_cpd_finish_row(a, stride, i, from, to, ridge);
    }
}

REGI_API void regi_cpd_back_solve(const double *l, int n, size_t stride, double *b)
{
    for (int i = 0; i < n; i++) {
        const double *row = l + (size_t)i * stride;
        double sum = b[i];
        for (int j = 0; j < i; j++)
            sum -= row[j] * b[j];
        b[i] = sum / row[i];
    }
    for (int i = n - 1; i >= 0; i--) {
        const double *row = l + (size_t)i * stride;
        b[i] /= row[i];
        for (int j = 0; j < i; j++)
            b[j] -= row[j] * b[i];
    }
}

REGI_API double regi_cpd_kernel_solve(regi_cpd_kernel *kernel, const double *p, double *const r[3], double ridge,
                                      const sb_jobs *jobs)
{
    double energy = 0;
    regi_cpd_assemble(kernel, p, ridge, jobs);
    regi_cpd_factor(kernel->system, kernel->rank, kernel->stride, ridge);
    for (int axis = 0; axis < 3; axis++) {
        double *c = kernel->weights[axis];
        for (int k = 0; k < kernel->rank; k++)
            c[k] = regi_cpd_dot(kernel->columns + (size_t)k * kernel->rows, r[axis], kernel->rows);
        regi_cpd_back_solve(kernel->system, kernel->rank, kernel->stride, c);
        energy += regi_cpd_dot(c, c, kernel->stride);
    }
    return energy;
}

REGI_API void regi_cpd_kernel_move(const regi_cpd_kernel *kernel, const regi_cpd_block *points, regi_cpd_block *moved)
{
    int blocks = (int)(kernel->rows / REGI_CPD_LANES);
    memcpy(moved, points, (size_t)blocks * sizeof *moved);
    for (int b = 0; b < blocks; b++)
        for (int k = 0; k < kernel->rank; k++) {
            const double *column = kernel->columns + (size_t)k * kernel->rows + (size_t)b * REGI_CPD_LANES;
            regi_cpd_add(moved[b].x, kernel->weights[0][k], column, REGI_CPD_LANES);
            regi_cpd_add(moved[b].y, kernel->weights[1][k], column, REGI_CPD_LANES);
            regi_cpd_add(moved[b].z, kernel->weights[2][k], column, REGI_CPD_LANES);
        }
}

/* L^-T of the pivots' rows, which are lower triangular: row pivots[k] of column j is 0 for j > k. */
REGI_API void regi_cpd_kernel_spread(regi_cpd_kernel *kernel)
{
    for (int axis = 0; axis < 3; axis++) {
        double *c = kernel->weights[axis];
        for (int k = kernel->rank - 1; k >= 0; k--) {
            const double *column = kernel->columns + (size_t)k * kernel->rows;
            double sum = c[k];
            for (int i = k + 1; i < kernel->rank; i++)
                sum -= column[kernel->pivots[i]] * c[i];
            c[k] = sum / column[kernel->pivots[k]];
        }
    }
}
