/* pcg: conjugate gradients with fused vector loops. */
#include "pcg.h"

#include <math.h>
#include <string.h>

/* ---- workspace ----------------------------------------------------------------------------------------- */

SB_API sb_pcg_options sb_default_pcg_options(void)
{
    sb_pcg_options options;
    options.tolerance = SB_REAL_IS_FLOAT ? 1e-3 : 1e-6;
    options.max_iterations = 1000;
    options.jobs = NULL;
    return options;
}

SB_API sb_result sb_pcg_workspace_create(int row_count, const sb_allocator *allocator,
                                         sb_pcg_workspace *workspace, sb_error *error)
{
    sb_pcg_workspace made;
    size_t entries, bytes = 0;
    if (!workspace || row_count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a workspace needs row_count >= 1, not %d", row_count);
    memset(&made, 0, sizeof made);
    if (allocator)
        made.allocator = *allocator;
    entries = 3 * (size_t)row_count;
    if (sbi_size_add(&bytes, (size_t)sbi_row_chunks(row_count), 2 * sizeof(double)) &&
        sbi_size_add(&bytes, entries, 5 * sizeof(sb_real)))
        made.memory = sbi_alloc(allocator, bytes, 1);
    if (!made.memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the vectors of %d rows", row_count);
    made.row_count = row_count;
    made.partial = (double *)made.memory;
    made.start = (sb_real *)(void *)(made.partial + 2 * sbi_row_chunks(row_count));
    made.residual = made.start + entries;
    made.search = made.residual + entries;
    made.direction = made.search + entries;
    made.product = made.direction + entries;
    *workspace = made;
    return SB_OK;
}

SB_API void sb_pcg_workspace_free(sb_pcg_workspace *workspace)
{
    if (!workspace)
        return;
    sbi_free(&workspace->allocator, workspace->memory);
    memset(workspace, 0, sizeof *workspace);
}

/* ---- vector loops -------------------------------------------------------------------------------------- */

/* What the chunk tasks see. Names follow the usual ones: r residual, z = M^-1 r, p direction, q = A p. */
typedef struct sbi_pcg_state {
    const sb_matrix *matrix;
    const sb_real *rhs;
    sb_real *x, *r, *z, *p, *q;
    const sb_real *start; /* x as it was given */
    sb_real factor;  /* of the update at work */
    sbi_multigrid *compact; /* what multiplies in place of the matrix, or NULL */
    int current;            /* 1: it is known to be of this matrix */
    int fresh;              /* 1: the iteration starts; 0: it goes on along p, whose step was `alpha` */
    double alpha, last_rz;
    double *partial; /* [chunks][2] */
    const sb_jobs *jobs;
} sbi_pcg_state;

static size_t sbi_pcg_end(const sbi_pcg_state *s, int chunk)
{
    int rows = s->matrix->row_count, first = chunk * SBI_ROW_CHUNK;
    return 3 * (size_t)(rows - first < SBI_ROW_CHUNK ? rows : first + SBI_ROW_CHUNK);
}

/* a.b over a range: eight sums that do not wait for each other. */
static double sbi_pcg_dot(const sb_real *a, const sb_real *b, size_t count)
{
    double s0 = 0, s1 = 0, s2 = 0, s3 = 0, s4 = 0, s5 = 0, s6 = 0, s7 = 0;
    size_t k = 0;
    for (; k + 8 <= count; k += 8) {
        s0 += (double)a[k] * (double)b[k];
        s1 += (double)a[k + 1] * (double)b[k + 1];
        s2 += (double)a[k + 2] * (double)b[k + 2];
        s3 += (double)a[k + 3] * (double)b[k + 3];
        s4 += (double)a[k + 4] * (double)b[k + 4];
        s5 += (double)a[k + 5] * (double)b[k + 5];
        s6 += (double)a[k + 6] * (double)b[k + 6];
        s7 += (double)a[k + 7] * (double)b[k + 7];
    }
    for (; k < count; k++)
        s0 += (double)a[k] * (double)b[k];
    return ((s0 + s1) + (s2 + s3)) + ((s4 + s5) + (s6 + s7));
}

static void sbi_pcg_square_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    size_t begin = 3 * (size_t)chunk * SBI_ROW_CHUNK, count = sbi_pcg_end(s, chunk) - begin;
    s->partial[2 * chunk] = sbi_pcg_dot(s->rhs + begin, s->rhs + begin, count);
    s->partial[2 * chunk + 1] = sbi_pcg_dot(s->x + begin, s->x + begin, count);
}

/* to = A v for the rows of a chunk; v is spread where there is a compact matrix. */
static void sbi_pcg_multiply(const sbi_pcg_state *s, const sb_real *v, sb_real *to, int first, int last)
{
    if (s->compact)
        sbi_multigrid_multiply(s->compact, to, first, last);
    else
        sbi_matrix_multiply_rows(s->matrix, v, to, first, last);
}

/* The compact matrix's x, and |S x|^2. */
static void sbi_pcg_spread_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    size_t begin = 3 * (size_t)chunk * SBI_ROW_CHUNK, end = sbi_pcg_end(s, chunk);
    s->partial[2 * chunk] = sbi_multigrid_spread(s->compact, s->x, (int)(begin / 3), (int)(end / 3));
}

/* r = rhs - A x, r.r */
static void sbi_pcg_residual_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    size_t begin = 3 * (size_t)chunk * SBI_ROW_CHUNK, end = sbi_pcg_end(s, chunk);
    sbi_pcg_multiply(s, s->x, s->r, (int)(begin / 3), (int)(end / 3));
    for (size_t k = begin; k < end; k++)
        s->r[k] = s->rhs[k] - s->r[k];
    s->partial[2 * chunk] = sbi_pcg_dot(s->r + begin, s->r + begin, end - begin);
}

/* q = A p, p.q */
static void sbi_pcg_product_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    size_t begin = 3 * (size_t)chunk * SBI_ROW_CHUNK, end = sbi_pcg_end(s, chunk);
    sbi_pcg_multiply(s, s->p, s->q, (int)(begin / 3), (int)(end / 3));
    s->partial[2 * chunk] = sbi_pcg_dot(s->p + begin, s->q + begin, end - begin);
}

/* x += factor p, r -= factor q, r.r */
static void sbi_pcg_advance_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    size_t begin = 3 * (size_t)chunk * SBI_ROW_CHUNK, count = sbi_pcg_end(s, chunk) - begin;
    sb_real *SB_RESTRICT x = s->x + begin, *SB_RESTRICT r = s->r + begin;
    const sb_real *p = s->p + begin, *q = s->q + begin;
    sb_real factor = s->factor;
    for (size_t k = 0; k < count; k++) {
        x[k] += factor * p[k];
        r[k] -= factor * q[k];
    }
    s->partial[2 * chunk] = sbi_pcg_dot(r, r, count);
}

/* r.z and q.z */
static void sbi_pcg_dots_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    size_t begin = 3 * (size_t)chunk * SBI_ROW_CHUNK, count = sbi_pcg_end(s, chunk) - begin;
    s->partial[2 * chunk] = sbi_pcg_dot(s->r + begin, s->z + begin, count);
    s->partial[2 * chunk + 1] = sbi_pcg_dot(s->q + begin, s->z + begin, count);
}

/* p = z + factor p */
static void sbi_pcg_direction_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    size_t begin = 3 * (size_t)chunk * SBI_ROW_CHUNK, count = sbi_pcg_end(s, chunk) - begin;
    sb_real *SB_RESTRICT p = s->p + begin;
    const sb_real *SB_RESTRICT z = s->z + begin;
    sb_real factor = s->factor;
    for (size_t k = 0; k < count; k++)
        p[k] = z[k] + factor * p[k];
    if (s->compact)
        sbi_multigrid_spread(s->compact, s->p, (int)(begin / 3), (int)((begin + count) / 3));
}

/* Runs a task over all chunks; the sum of the chunks' first (or second) partial sums, in order. */
static double sbi_pcg_run(sbi_pcg_state *s, sb_task task, double *second)
{
    int chunks = sbi_row_chunks(s->matrix->row_count);
    double sum = 0, other = 0;
    sbi_run(s->jobs, task, s, chunks);
    for (int k = 0; k < chunks; k++)
        sum += s->partial[2 * k];
    for (int k = 0; second && k < chunks; k++)
        other += s->partial[2 * k + 1];
    if (second)
        *second = other;
    return sum;
}

/* ---- the iteration ------------------------------------------------------------------------------------- */

static int sbi_pcg_is_finite(double value) { return value - value == 0; }

/* Subtracts the coarse space's part from the residual, as its deflation requires; returns the new r.r. Uses p
 * and q. */
static double sbi_pcg_deflate(sbi_pcg_state *s, sb_preconditioner *preconditioner, double square)
{
    if (!preconditioner || !sbi_precond_coarse_solve(preconditioner, s->r, s->p, sqrt(square)))
        return square;
    s->compact = NULL; /* a preconditioner with a coarse space has none */
    sbi_pcg_run(s, sbi_pcg_product_task, NULL);
    s->factor = 1;
    return sbi_pcg_run(s, sbi_pcg_advance_task, NULL);
}

/* Iterates until r.r <= target, in plain PCG with the flexible beta = (r_new - r).z_new / (r.z)_old: with
 * r_new - r = -alpha q it costs one more sum and makes up for a preconditioner that rounding keeps from being
 * quite symmetric. */
static sb_result sbi_pcg_iterate(sbi_pcg_state *s, sb_preconditioner *preconditioner, double target,
                                 int max_iterations, double *square, sb_pcg_info *info)
{
    while (*square > target) {
        double rz, qz, pq;
        if (info->iterations >= max_iterations) {
            info->capped = 1;
            return SB_ERROR_NOT_CONVERGED;
        }
        if (preconditioner)
            sbi_precond_apply(preconditioner, s->r, s->z, sqrt(*square));
        else
            memcpy(s->z, s->r, 3 * (size_t)s->matrix->row_count * sizeof(sb_real));
        if (s->fresh)
            memset(s->p, 0, 3 * (size_t)s->matrix->row_count * sizeof(sb_real));
        if (s->fresh)
            memset(s->q, 0, 3 * (size_t)s->matrix->row_count * sizeof(sb_real));
        rz = sbi_pcg_run(s, sbi_pcg_dots_task, &qz);
        if (!sbi_pcg_is_finite(rz))
            return SB_ERROR_DIVERGED;
        if (rz <= 0) {
            if (!preconditioner || !sbi_precond_soften(preconditioner))
                return SB_ERROR_INDEFINITE;
            s->fresh = 1;
            continue;
        }
        s->factor = s->fresh ? 0 : (sb_real)(-s->alpha * qz / s->last_rz);
        sbi_run(s->jobs, sbi_pcg_direction_task, s, sbi_row_chunks(s->matrix->row_count));
        pq = sbi_pcg_run(s, sbi_pcg_product_task, NULL);
        if (!sbi_pcg_is_finite(pq))
            return SB_ERROR_DIVERGED;
        if (pq <= 0) {
            info->negative_curvature = 1;
            return SB_ERROR_INDEFINITE;
        }
        s->alpha = rz / pq;
        s->last_rz = rz;
        s->factor = (sb_real)s->alpha;
        *square = sbi_pcg_run(s, sbi_pcg_advance_task, NULL);
        if (!sbi_pcg_is_finite(*square))
            return SB_ERROR_DIVERGED;
        info->iterations++;
        s->fresh = 0;
    }
    return SB_OK;
}

/* r = rhs - A x with the matrix itself, when the residual in r is of the compact one; r.r. */
static double sbi_pcg_true_residual(sbi_pcg_state *s)
{
    sbi_multigrid *compact = s->compact;
    double square;
    s->compact = NULL;
    square = sbi_pcg_run(s, sbi_pcg_residual_task, NULL);
    s->compact = compact;
    return square;
}

/* r = rhs - A x, r.r, with the compact matrix where that is known to be of this one. */
static double sbi_pcg_first_residual(sbi_pcg_state *s)
{
    if (!s->compact || !s->current)
        return sbi_pcg_true_residual(s);
    sbi_run(s->jobs, sbi_pcg_spread_task, s, sbi_row_chunks(s->matrix->row_count));
    return sbi_pcg_run(s, sbi_pcg_residual_task, NULL);
}

/* 1 when the residual meets the target also with all that the compact matrix's may be off. */
static int sbi_pcg_is_sure(sbi_pcg_state *s, double square, double target)
{
    double off;
    if (!s->current)
        return 0;
    off = sbi_multigrid_deviation(s->compact) * sqrt(sbi_pcg_run(s, sbi_pcg_spread_task, NULL));
    return sqrt(square) + off <= sqrt(target);
}

/* 1 when an iteration's result can stand without a look at the true residual: what was found without the compact
 * matrix, and with it what is sure. That it is indefinite may come from its rounding. */
static int sbi_pcg_is_final(sbi_pcg_state *s, sb_result result, int verify, double square, double target)
{
    if (!s->compact)
        return result != SB_OK || !verify;
    if (result == SB_OK)
        return !verify && sbi_pcg_is_sure(s, square, target);
    if (result == SB_ERROR_NOT_CONVERGED)
        return s->current;
    return result != SB_ERROR_INDEFINITE;
}

/* Solves, checking the true residual where the recurrence cannot be trusted; *square is r.r of the returned
 * x. With the compact matrix the true one replaces it every few digits, and the iteration goes on as if nothing had
 * happened: what the compact one is off by is then a share of the little that is left to add to x. */
static sb_result sbi_pcg_refine(sbi_pcg_state *s, sb_preconditioner *preconditioner,
                                const sb_pcg_options *options, double rhs_square, double *square,
                                sb_pcg_info *info)
{
    const double digits = 1e-3;
    double tolerance = options->tolerance, target = tolerance * tolerance * rhs_square, before = *square;
    double least =
        (double)SB_EPSILON * (double)SB_EPSILON / 16 * rhs_square; /* below, the recurrence counts nothing */
    int verify = tolerance * tolerance * tolerance < (double)SB_EPSILON;
    if (s->compact && s->current && *square <= target) /* a start as good as that: without the compact one's rounding */
        *square = sbi_pcg_true_residual(s);
    for (int round = 0;; round++) {
        sb_result result;
        double goal = target > least ? target : least, recurred;
        if (*square <= target)
            return SB_OK;
        *square = sbi_pcg_deflate(s, preconditioner, *square);
        if (!sbi_pcg_is_finite(*square))
            return SB_ERROR_DIVERGED;
        if (s->compact && goal < digits * digits * *square)
            goal = digits * digits * *square;
        result = sbi_pcg_iterate(s, preconditioner, goal, options->max_iterations, square, info);
        info->residual_is_true = 0;
        if (sbi_pcg_is_final(s, result, verify, *square, target))
            return result;
        recurred = *square;
        *square = sbi_pcg_true_residual(s);
        info->residual_is_true = 1;
        if (!sbi_pcg_is_finite(*square))
            return SB_ERROR_DIVERGED;
        if (*square <= target)
            return SB_OK;
        if (result == SB_ERROR_NOT_CONVERGED)
            return result;
        /* not even halved, or where less was to be done, no better: the last digit of x is reached */
        if (*square > (before > 4 * target ? 0.25 : 0.99) * before && !s->compact)
            return SB_ERROR_NOT_CONVERGED;
        s->fresh = result != SB_OK || !s->compact || *square > 4 * recurred;
        if (s->compact && *square > before && round == 0 && !s->current) { /* it is none of this matrix */
            memcpy(s->x, s->start, 3 * (size_t)s->matrix->row_count * sizeof(sb_real));
            *square = sbi_pcg_true_residual(s);
            s->fresh = 1;
            s->compact = NULL;
        }
        if (*square > before || *square > 1.5 * recurred || result != SB_OK)
            s->compact = NULL;
        info->negative_curvature = 0; /* of the compact matrix, if any */
        before = *square;
    }
}

static int sbi_pcg_valid(const sb_matrix *matrix, const sb_preconditioner *preconditioner, const sb_real *rhs,
                         const sb_real *x, const sb_pcg_options *options, const sb_pcg_workspace *workspace)
{
    if (!matrix || !rhs || !x || !workspace || workspace->row_count != matrix->row_count)
        return 0;
    if (preconditioner && sbi_precond_rows(preconditioner) != matrix->row_count)
        return 0;
    return options->tolerance >= 0 && sbi_pcg_is_finite(options->tolerance) && options->max_iterations >= 0;
}

static sb_result sbi_pcg_run_solve(const sb_matrix *matrix, sb_preconditioner *preconditioner, const sb_real *rhs,
                                   sb_real *x, const sb_pcg_options *options, sb_pcg_workspace *workspace,
                                   int current, sb_pcg_info *info)
{
    sb_pcg_options defaults = sb_default_pcg_options();
    sb_pcg_info report;
    sbi_pcg_state state;
    sb_result result;
    double rhs_square, x_square = 0, square = 0;
    size_t bytes;
    options = options ? options : &defaults;
    if (!sbi_pcg_valid(matrix, preconditioner, rhs, x, options, workspace))
        return SB_ERROR_ARGUMENT;
    memset(&report, 0, sizeof report);
    bytes = 3 * (size_t)matrix->row_count * sizeof(sb_real);
    state.matrix = matrix;
    state.rhs = rhs;
    state.x = x;
    state.start = workspace->start;
    state.r = workspace->residual;
    state.z = workspace->search;
    state.p = workspace->direction;
    state.q = workspace->product;
    state.partial = workspace->partial;
    state.jobs = options->jobs;
    state.factor = 0;
    state.fresh = 1;
    state.alpha = state.last_rz = 0;
    state.compact = preconditioner ? sbi_precond_compact(preconditioner) : NULL;
    state.current = current;
    memcpy(workspace->start, x, bytes);
    rhs_square = sbi_pcg_run(&state, sbi_pcg_square_task, &x_square);
    if (rhs_square > 0 && x_square == 0) { /* no product needed */
        memcpy(state.r, rhs, bytes);
        square = rhs_square;
    } else if (rhs_square > 0) {
        square = sbi_pcg_first_residual(&state);
    } else if (rhs_square == 0) {
        memset(x, 0, bytes);
    }
    report.residual_is_true = 1;
    if (!sbi_pcg_is_finite(rhs_square) || !sbi_pcg_is_finite(square))
        result = SB_ERROR_DIVERGED;
    else
        result = sbi_pcg_refine(&state, preconditioner, options, rhs_square, &square, &report);
    if (result == SB_ERROR_DIVERGED) {
        memcpy(x, workspace->start, bytes);
        report.residual_is_true = 0;
    }
    report.residual = rhs_square > 0 ? sqrt(square / rhs_square) : 0;
    if (info)
        *info = report;
    return result;
}

SB_API sb_result sb_pcg_solve(const sb_matrix *matrix, sb_preconditioner *preconditioner, const sb_real *rhs,
                              sb_real *x, const sb_pcg_options *options, sb_pcg_workspace *workspace,
                              sb_pcg_info *info)
{
    return sbi_pcg_run_solve(matrix, preconditioner, rhs, x, options, workspace, 0, info);
}

SBI_API sb_result sbi_pcg_solve_current(const sb_matrix *matrix, sb_preconditioner *preconditioner, const sb_real *rhs,
                                        sb_real *x, const sb_pcg_options *options, sb_pcg_workspace *workspace,
                                        sb_pcg_info *info)
{
    return sbi_pcg_run_solve(matrix, preconditioner, rhs, x, options, workspace, 1, info);
}
