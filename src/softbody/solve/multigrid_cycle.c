/* multigrid_cycle: values of the levels, and the V-cycle. */
#include "multigrid_block.h"

#include <float.h>
#include <math.h>
#include <string.h>

/* ---- tasks --------------------------------------------------------------------------------------------- */

/* What the tasks of one level see. */
typedef struct sbi_mg_work {
    sbi_multigrid *m;
    sbi_mg_level *level;     /* whose rows the tasks are, */
    sbi_mg_level *finer;     /* and the one above it or NULL */
    const sb_matrix *matrix; /* of level 0, in updates */
    double scale;
    const sb_real *in;
    sb_real *out;
    sb_real factor;
    float keep, add;   /* of a Chebyshev step: d' = keep d + add D^-1 r */
    int first_after;   /* 1: the step after a coarser level's, whose motion is in e */
    int last;          /* 1: only the residual is wanted */
    float alpha, beta; /* of the estimate of the bound */
} sbi_mg_work;

static int sbi_mg_end(const sbi_mg_level *level, int task)
{
    int first = task * SBI_MG_ROWS;
    return level->row_count - first < SBI_MG_ROWS ? level->row_count : first + SBI_MG_ROWS;
}

static int sbi_mg_tasks(const sbi_mg_level *level)
{
    return level->row_count / SBI_MG_ROWS + (level->row_count % SBI_MG_ROWS != 0);
}

static void sbi_mg_run(sbi_mg_work *work, sb_task task)
{
    sbi_run(work->level->row_count < SBI_MG_THREADED ? NULL : &work->m->jobs, task, work, sbi_mg_tasks(work->level));
}

static double sbi_mg_sum(const sbi_mg_level *level)
{
    double sum = 0;
    for (int t = 0; t < sbi_mg_tasks(level); t++)
        sum += level->partial[t];
    return sum;
}

/* ---- update -------------------------------------------------------------------------------------------- */

/* Inverse of a symmetric block where it has stiffness, 0 elsewhere and where single precision does not hold it, by
 * sweeps; returns how many directions have. */
static int sbi_mg_invert(const float *block, float *inverse)
{
    double a[9];
    int kept = 0;
    for (int k = 0; k < 9; k++)
        a[k] = (double)block[k];
    for (int k = 0; k < 3; k++) {
        double pivot = a[4 * k], least = 64 * (double)FLT_EPSILON * (double)block[4 * k];
        int keep = pivot > (double)FLT_MIN / (double)FLT_EPSILON && pivot > least; /* false for NaN */
        double inverse_pivot = keep ? 1 / pivot : 0, column[3], row[3];
        for (int i = 0; i < 3; i++) {
            column[i] = keep ? a[3 * i + k] * inverse_pivot : 0;
            row[i] = keep ? a[3 * k + i] : 0;
        }
        for (int i = 0; i < 9; i++)
            if (i / 3 != k && i % 3 != k)
                a[i] -= column[i / 3] * row[i % 3];
        for (int i = 0; i < 3; i++)
            a[3 * i + k] = a[3 * k + i] = column[i];
        a[4 * k] = -inverse_pivot;
        kept += keep;
    }
    for (int k = 0; k < 12; k++)
        inverse[k] = k % 4 < 3 ? (float)-a[3 * (k / 4) + k % 4] : 0.0f;
    return kept;
}

/* The largest entry on the diagonal of a node's block of its free components, or of all where none is. */
static sb_real sbi_mg_largest_free(const sb_real *block, unsigned fixed)
{
    sb_real largest = 0;
    for (unsigned k = 0; k < 3; k++)
        if ((fixed == SB_XYZ || !(fixed >> k & 1)) && block[4 * k] > largest)
            largest = block[4 * k];
    return largest;
}

/* The block with that in place of the diagonal of held components: what stands there nobody multiplies with but 0, and
 * where a node's own stiffness is next to nothing beside it, S by it would leave its free components to rounding. */
static void sbi_mg_level_held(const sb_real *block, unsigned fixed, sb_real *out)
{
    sb_real largest = sbi_mg_largest_free(block, fixed);
    for (unsigned k = 0; k < 9; k++)
        out[k] = k % 4 == 0 && fixed != SB_XYZ && fixed >> k / 4 & 1 ? largest : block[k];
}

/* S of a node of level 0, and the inverse of its scaled diagonal block; 0 when that is not positive definite. */
static int sbi_mg_load_diagonal(const sbi_mg_work *work, int i)
{
    const sbi_mg_level *level = work->level;
    const sb_real *block = work->matrix->blocks[work->matrix->diagonal[i]];
    float *scale = level->scale + 4 * (size_t)i, scaled[9];
    int later = work->matrix->diagonal[sbi_min_int(i + SBI_MG_ROWS_AHEAD, level->row_count - 1)];
    double largest, inverse;
    sb_real own[9];
    SBI_PREFETCH(work->matrix->blocks[later], 0);
    largest = (double)sbi_mg_largest_free(block, work->matrix->fixed[i]);
    if (!(largest > 0))
        return 0;
    sbi_mg_level_held(block, work->matrix->fixed[i], own);
    largest *= work->scale;
    inverse = 1 / sqrt(largest);
    for (int k = 0; k < 3; k++)
        scale[k] = work->matrix->fixed[i] >> k & 1 ? 0.0f : (float)sqrt(largest);
    scale[3] = (float)inverse;
    for (int k = 0; k < 9; k++)
        scaled[k] = (float)((double)own[k] * work->scale / largest);
    return sbi_mg_invert(scaled, level->inverse + 12 * (size_t)i) == 3;
}

static void sbi_mg_diagonal_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    int bad = -1;
    for (int i = task * SBI_MG_ROWS; i < sbi_mg_end(work->level, task); i++)
        if (!sbi_mg_load_diagonal(work, i) && bad < 0)
            bad = i;
    work->level->partial[task] = bad;
}

SBI_FORCE_INLINE void sbi_mg_round_block(const sb_real *from, sb_real scale, float *block)
{
    for (int k = 0; k < 8; k++)
        block[k] = (float)(from[k] * scale);
    block[8] = (float)(from[8] * scale);
}

/* Where rows of A P are made. */
typedef struct sbi_mg_mixer {
    const int *parent_start, *slot;
    const float *shares;
    float *mixed;
} sbi_mg_mixer;

static sbi_mg_mixer sbi_mg_begin_mixing(const sbi_mg_level *level, int i)
{
    int first = level->mixed_start[i], count = level->mixed_start[i + 1] - first;
    sbi_mg_mixer mixer;
    mixer.mixed = level->mixed + 9 * (size_t)first;
    memset(mixer.mixed, 0, 9 * (size_t)count * sizeof(float));
    mixer.parent_start = level->parent_start;
    mixer.shares = level->shares;
    mixer.slot = level->slots + level->slot_start[i];
    return mixer;
}

/* Adds a block of A in column j. */
SBI_FORCE_INLINE void sbi_mg_mix(sbi_mg_mixer *mixer, int j, const float *block)
{
    const int *slot = mixer->slot;
    int last = mixer->parent_start[j + 1];
    for (int k = mixer->parent_start[j]; k < last; k++)
        sbi_mg_add_block(mixer->shares[k], block, mixer->mixed + 9 * (size_t)*slot++);
    mixer->slot = slot;
}

/* Block q of level 0, `from` in the matrix and `block` in floats, times `own` and `other`: in 32 bits an entry where
 * there is a rest, in 16 without. */
SBI_FORCE_INLINE void sbi_mg_pack_finest(const sbi_mg_work *work, size_t q, const sb_real *from, const float *block,
                                         float own, float other, int *bad)
{
    const sbi_mg_level *level = work->level;
#if !SB_REAL_IS_FLOAT
    if (level->rest) {
        sbi_mg_pack_words(from, (double)own * (double)other * (work->scale * SBI_MG_WORD), level->packed + 9 * q,
                          level->rest + 9 * q, bad);
        return;
    }
#endif
    (void)bad;
    (void)from;
    sbi_mg_pack(block, (own * other) * SBI_MG_ONE, level->packed + 9 * q);
}

/* Row i of level 0 from the matrix, and of its A P, in one pass over the matrix. The diagonal of prescribed components
 * does not reach the coarser level. Returns 1 when an entry is beyond the range. */
static int sbi_mg_load_row(const sbi_mg_work *work, int i)
{
    const sbi_mg_level *level = work->level;
    const sb_real(*from)[9] = (const sb_real(*)[9])work->matrix->blocks + work->matrix->row_start[i];
    const sb_real scale = (sb_real)work->scale;
    const float *scales = level->scale, own = scales[4 * (size_t)i + 3];
    const int *columns = level->columns, last = level->row_start[i + 1], mixes = level->mixed != NULL;
    int16_t *packed = level->packed;
    int bad = 0;
    sbi_mg_mixer mixer = {NULL, NULL, NULL, NULL};
    if (mixes)
        mixer = sbi_mg_begin_mixing(level, i);
    for (int q = level->row_start[i]; q < last; q++, from++) {
        const sb_real *source = *from;
        sb_real held[9];
        float block[9];
        int j = columns[q];
        SBI_PREFETCH(*from, SBI_MG_AHEAD);
        SBI_PREFETCH(*from, SBI_MG_AHEAD + 64);
        SBI_PREFETCH(packed + 9 * (size_t)q, SBI_MG_AHEAD / 8);
        if (mixes)
            SBI_PREFETCH(mixer.slot, SBI_MG_AHEAD / 8);
        if (j == i && work->matrix->fixed[i]) {
            sbi_mg_level_held(*from, work->matrix->fixed[i], held);
            source = held;
        }
        sbi_mg_round_block(source, scale, block);
        sbi_mg_pack_finest(work, (size_t)q, source, block, own, scales[4 * (size_t)j + 3], &bad);
        for (int k = 0; k < 9 && j == i; k++)
            block[k] = scales[4 * (size_t)i + (size_t)(k / 3)] > 0 ? block[k] : 0.0f;
        if (mixes)
            sbi_mg_mix(&mixer, j, block);
    }
    return bad;
}

/* Row i of A P. */
static void sbi_mg_mix_row(const sbi_mg_level *level, int i)
{
    sbi_mg_mixer mixer = sbi_mg_begin_mixing(level, i);
    const int *columns = level->columns, last = level->row_start[i + 1];
    const float *blocks = level->blocks;
    for (int q = level->row_start[i]; q < last; q++)
        sbi_mg_mix(&mixer, columns[q], blocks + 9 * (size_t)q);
}

/* Row a of P^T (A P) from its diagonal on, from the finer level. */
static void sbi_mg_gather_row(const sbi_mg_level *level, const sbi_mg_level *finer, int a)
{
    for (int q = level->diagonal[a]; q < level->row_start[a + 1]; q++) {
        size_t first = finer->sum_start[q], last = finer->sum_start[q + 1];
        sbi_mg_sum_blocks(finer->sum_blocks + first, finer->sum_blocks + last, finer->sum_shares + first, finer->mixed,
                          level->blocks + 9 * (size_t)q);
    }
}

/* What is before the diagonal, when all rows have the rest. */
static void sbi_mg_mirror_row(const sbi_mg_level *level, const sbi_mg_level *finer, int a)
{
    for (int q = level->row_start[a]; q < level->diagonal[a]; q++) {
        const float *from = level->blocks + 9 * (size_t)finer->twins[q];
        float *to = level->blocks + 9 * (size_t)q;
        for (int k = 0; k < 9; k++)
            to[k] = from[3 * (k % 3) + k / 3];
    }
}

/* S of a row of a coarser level, and the inverse of its diagonal block as the scaled one's. */
static void sbi_mg_scale_row(const sbi_mg_level *level, int a)
{
    const float *block = level->blocks + 9 * (size_t)level->diagonal[a];
    float *scale = level->scale + 4 * (size_t)a, *inverse = level->inverse + 12 * (size_t)a, largest = 0;
    for (int k = 0; k < 9; k += 4)
        largest = block[k] > largest ? block[k] : largest;
    largest = largest > 0 ? largest : 1; /* all that moves with it is prescribed */
    for (int k = 0; k < 3; k++)
        scale[k] = sqrtf(largest);
    scale[3] = 1 / scale[0];
    for (int k = 0; k < 12; k++)
        inverse[k] *= largest;
}

/* Rows of a coarser level in 16 bits, when all are scaled. */
static void sbi_mg_pack_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    const sbi_mg_level *level = work->level;
    const float *scales = level->scale;
    for (int a = task * SBI_MG_ROWS; a < sbi_mg_end(level, task); a++)
        for (int q = level->row_start[a]; q < level->row_start[a + 1]; q++)
            sbi_mg_pack(level->blocks + 9 * (size_t)q,
                        (scales[4 * (size_t)a + 3] * scales[4 * (size_t)level->columns[q] + 3]) * SBI_MG_ONE,
                        level->packed + 9 * (size_t)q);
}

static void sbi_mg_load_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    int bad = 0;
    for (int i = task * SBI_MG_ROWS; i < sbi_mg_end(work->level, task); i++)
        bad |= sbi_mg_load_row(work, i);
    work->level->partial[task] = bad;
}

/* Where moduli jump by 1,000, the motion of a stiff part as a whole costs so little that the rounding of its rows to 16
 * bits is felt: without this six slabs take one or two iterations more of eight. What the blocks of row i lose of a
 * translation is added to the diagonal block. */
static void sbi_mg_mend_row(const sbi_mg_work *work, int i)
{
    const sbi_mg_level *level = work->level;
    const double own = (double)level->scale[4 * (size_t)i + 3], exact = work->scale * own * own;
    double lost[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
    for (int q = level->row_start[i], at = work->matrix->row_start[i]; q < level->row_start[i + 1]; q++, at++) {
        const sb_real *from = work->matrix->blocks[at];
        const int16_t *packed = level->packed + 9 * (size_t)q;
        double unit = own / ((double)level->scale[4 * (size_t)level->columns[q] + 3] * (double)SBI_MG_ONE);
        for (int k = 0; k < 9; k++)
            lost[k] += (double)from[k] * exact - packed[k] * unit;
    }
    for (int k = 0; k < 9; k++)
        level->mend[12 * (size_t)i + (size_t)(4 * (k / 3) + k % 3)] =
            (float)((lost[k] + lost[3 * (k % 3) + k / 3]) / 2);
}

static void sbi_mg_mend_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    for (int i = task * SBI_MG_ROWS; i < sbi_mg_end(work->level, task); i++)
        sbi_mg_mend_row(work, i);
}

static void sbi_mg_gather_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    for (int a = task * SBI_MG_ROWS; a < sbi_mg_end(work->level, task); a++)
        sbi_mg_gather_row(work->level, work->finer, a);
}

/* Whole rows of a coarser level with all that the next one needs of them. */
static void sbi_mg_complete_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    const sbi_mg_level *level = work->level;
    for (int a = task * SBI_MG_ROWS; a < sbi_mg_end(level, task); a++) {
        sbi_mg_mirror_row(level, work->finer, a);
        sbi_mg_invert(level->blocks + 9 * (size_t)level->diagonal[a], level->inverse + 12 * (size_t)a);
        if (level->packed)
            sbi_mg_scale_row(level, a);
        if (level->mixed)
            sbi_mg_mix_row(level, a);
    }
}

/* ---- bound of the smoother ----------------------------------------------------------------------------- */

/* r = a fixed vector without pattern, d = D^-1 r; r.d */
static void sbi_mg_bound_begin_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    sbi_mg_level *level = work->level;
    double sum = 0;
    for (int i = task * SBI_MG_ROWS; i < sbi_mg_end(level, task); i++) {
        float *r = level->r + 4 * (size_t)i, *d = level->d + 4 * (size_t)i;
        for (int k = 0; k < 3; k++) {
            uint32_t bits = ((uint32_t)i * 3u + (uint32_t)k + 1u) * 2654435761u;
            bits = (bits ^ (bits >> 15)) * 2246822519u;
            r[k] = (float)(bits >> 8) * (1.0f / 8388608.0f) - 1.0f;
            if (!level->packed)
                r[k] *= level->blocks[9 * (size_t)level->diagonal[i] + 4 * (size_t)k];
        }
        r[3] = d[3] = 0;
        sbi_f4_store(d, sbi_mg_relax(level->inverse + 12 * (size_t)i, sbi_f4_load(r)));
        sum += (double)r[0] * (double)d[0] + (double)r[1] * (double)d[1] + (double)r[2] * (double)d[2];
    }
    level->partial[task] = sum;
}

/* e = A d; d.e */
static void sbi_mg_bound_product_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    sbi_mg_level *level = work->level;
    double sum = 0;
    for (int i = task * SBI_MG_ROWS; i < sbi_mg_end(level, task); i++) {
        float *e = level->e + 4 * (size_t)i;
        const float *d = level->d + 4 * (size_t)i;
        sbi_f4_store(e, sbi_mg_multiply_row(level, i, level->d));
        sum += (double)d[0] * (double)e[0] + (double)d[1] * (double)e[1] + (double)d[2] * (double)e[2];
    }
    level->partial[task] = sum;
}

/* r -= alpha e, x = D^-1 r; r.x */
static void sbi_mg_bound_residual_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    sbi_mg_level *level = work->level;
    double sum = 0;
    for (int i = task * SBI_MG_ROWS; i < sbi_mg_end(level, task); i++) {
        float *r = level->r + 4 * (size_t)i, *x = level->x + 4 * (size_t)i;
        const float *e = level->e + 4 * (size_t)i;
        for (int k = 0; k < 3; k++)
            r[k] -= work->alpha * e[k];
        sbi_f4_store(x, sbi_mg_relax(level->inverse + 12 * (size_t)i, sbi_f4_load(r)));
        sum += (double)r[0] * (double)x[0] + (double)r[1] * (double)x[1] + (double)r[2] * (double)x[2];
    }
    level->partial[task] = sum;
}

/* d = x + beta d */
static void sbi_mg_bound_direction_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    sbi_mg_level *level = work->level;
    for (size_t k = 4 * SBI_MG_ROWS * (size_t)task; k < 4 * (size_t)sbi_mg_end(level, task); k++)
        level->d[k] = level->x[k] + work->beta * level->d[k];
}

/* Largest eigenvalue of a symmetric tridiagonal matrix: bisection with Sturm's count. */
static double sbi_mg_largest_eigenvalue(const double *diagonal, const double *side, int count)
{
    double low = 0, high = 0;
    for (int k = 0; k < count; k++) {
        double reach = diagonal[k] + (k ? fabs(side[k - 1]) : 0) + (k + 1 < count ? fabs(side[k]) : 0);
        high = reach > high ? reach : high;
        low = diagonal[k] > low ? diagonal[k] : low;
    }
    for (int step = 0; step < 20; step++) {
        double middle = (low + high) / 2, pivot = middle - diagonal[0];
        int below = pivot > 0; /* pivots of middle I - T: all positive when middle is above every eigenvalue */
        for (int k = 1; k < count && below; k++) {
            pivot = middle - diagonal[k] - side[k - 1] * side[k - 1] / pivot;
            below = pivot > 0;
        }
        if (below)
            high = middle;
        else
            low = middle;
    }
    return high;
}

/* Coefficients of Lanczos' process, from conjugate gradients' steps. */
typedef struct sbi_mg_lanczos {
    double diagonal[SBI_MG_LANCZOS_MOST], side[SBI_MG_LANCZOS_MOST];
    double rz, last_alpha, last_beta;
    int steps;
} sbi_mg_lanczos;

/* One more step, which costs a product; 0 when there is no more to be had. */
static int sbi_mg_lanczos_step(sbi_mg_work *work, sbi_mg_lanczos *l)
{
    double curvature, alpha, next;
    if (l->steps)
        sbi_mg_run(work, sbi_mg_bound_direction_task);
    sbi_mg_run(work, sbi_mg_bound_product_task);
    curvature = sbi_mg_sum(work->level);
    if (!(curvature > 0))
        return 0;
    alpha = l->rz / curvature;
    work->alpha = (float)alpha;
    sbi_mg_run(work, sbi_mg_bound_residual_task);
    next = sbi_mg_sum(work->level);
    l->diagonal[l->steps] = 1 / alpha + (l->steps ? l->last_beta / l->last_alpha : 0);
    l->last_beta = next / l->rz;
    l->last_alpha = alpha;
    l->side[l->steps] = next > 0 ? sqrt(l->last_beta) / alpha : 0;
    l->rz = next;
    work->beta = (float)l->last_beta;
    l->steps++;
    return next > 0;
}

/* Eigenvalues of D^-1 A from above, but for bad luck: Lanczos steps and a margin. Five steps come within 12 % of the
 * largest eigenvalue of solids' matrices, within 20 % where there are slivers; on coarser levels of regions they miss
 * up to a third, twelve a few per cent.
 *
 * Matrices of one body are much alike. The first step tells mean and deviation of the eigenvalues, as the fixed start
 * weighs them, and where the largest lies counted in deviations from the mean hardly changes: D^-1 A = I + N, and when
 * dt or the stiffness changes everywhere N is multiplied. So `reach`, that distance, is kept for some updates. */
static void sbi_mg_estimate_bound(sbi_mg_work *work, sbi_mg_reach *reach)
{
    sbi_mg_lanczos l;
    double bound = 1, deviations;
    int more, most = work->m->regions.count > 0 && work->finer ? SBI_MG_LANCZOS_MOST : SBI_MG_LANCZOS;
    memset(&l, 0, sizeof l);
    sbi_mg_run(work, sbi_mg_bound_begin_task);
    l.rz = sbi_mg_sum(work->level);
    more = l.rz > 0 && sbi_mg_lanczos_step(work, &l);
    if (more && reach && reach->deviations > 0 && reach->age < SBI_MG_REACH_AGE) {
        reach->age++;
        work->level->bound = l.diagonal[0] + reach->deviations * l.side[0];
        return;
    }
    while (more && l.steps < most)
        more = sbi_mg_lanczos_step(work, &l);
    if (l.steps)
        bound = (most == SBI_MG_LANCZOS ? 1.25 : 1.2) * sbi_mg_largest_eigenvalue(l.diagonal, l.side, l.steps);
    work->level->bound = bound;
    if (!reach)
        return;
    deviations = l.steps > 1 ? (bound - l.diagonal[0]) / l.side[0] : 0;
    reach->deviations = deviations > 0 && deviations < SBI_MG_MAX_REACH ? deviations : 0;
    reach->age = 0;
}

SBI_API int sbi_multigrid_soften(sbi_multigrid *m)
{
    if (m->softened == 6)
        return 0;
    m->softened++;
    for (int l = 0; l < m->level_count; l++)
        m->levels[l].bound *= 2;
    memset(&m->reach, 0, sizeof m->reach); /* it was too short */
    return 1;
}

/* ---- the product in 32 bits an entry ---- */

/* An entry is off by half a unit at most, 0.5 / (SBI_MG_WORD s) S_i S_j with the matrix scale s. So a row of the
 * difference D from the matrix has |D x|_i <= that S_i times the sum of |S_j x_j| over the three components of each
 * block of the row; and a matrix of ones on the pattern has no eigenvalue beyond its longest row. */
static void sbi_mg_set_deviation(sbi_mg_work *work)
{
    const sbi_mg_level *level = work->level;
    float least = FLT_MAX; /* 1 / S */
    work->m->matrix_scale = work->scale;
    work->m->deviation = 0;
    if (!level->rest || sbi_mg_sum(level) > 0)
        return;
    for (int i = 0; i < level->row_count; i++)
        least = level->scale[4 * (size_t)i + 3] < least ? level->scale[4 * (size_t)i + 3] : least;
    /* a little more than 0.5: entries are scaled in doubles */
    work->m->deviation = 0.51 * 3 * work->m->longest_row / (SBI_MG_WORD * work->scale * (double)least);
}

SBI_API double sbi_multigrid_deviation(const sbi_multigrid *m) { return m->deviation; }

SBI_API double sbi_multigrid_spread(sbi_multigrid *m, const sb_real *x, int first, int last)
{
    const float *scale = m->levels[0].scale;
    double square = 0;
    for (size_t i = (size_t)first; i < (size_t)last; i++) {
        double s = 1 / (double)scale[4 * i + 3], *to = m->spread + 4 * i;
        for (size_t k = 0; k < 3; k++)
            to[k] = s * (double)x[3 * i + k];
        to[3] = 0;
        square += to[0] * to[0] + to[1] * to[1] + to[2] * to[2];
    }
    return square;
}

SBI_API void sbi_multigrid_multiply(const sbi_multigrid *m, sb_real *y, int first, int last)
{
    const sbi_mg_level *level = m->levels;
    for (int i = first; i < last; i++) {
        size_t begin = 9 * (size_t)level->row_start[i];
        double back = 1 / ((double)level->scale[4 * (size_t)i + 3] * (m->matrix_scale * SBI_MG_WORD));
        double s[9], all[4], off;
        sbi_mg_sum_words(level->packed + begin, level->rest + begin, level->columns + level->row_start[i],
                         level->columns + level->row_start[i + 1], m->spread, s, all);
        off = 32768 * (all[0] + all[1] + all[2]);
        for (size_t k = 0; k < 3; k++)
            y[3 * (size_t)i + k] = (sb_real)((s[3 * k] + s[3 * k + 1] + s[3 * k + 2] - off) * back);
    }
}

/* ---- update, and what it remembers ---- */

SBI_API sbi_mg_reach sbi_multigrid_get_reach(const sbi_multigrid *m) { return m->reach; }
SBI_API void sbi_multigrid_set_reach(sbi_multigrid *m, sbi_mg_reach reach) { m->reach = reach; }

SBI_API int sbi_multigrid_update(sbi_multigrid *m, const sb_matrix *matrix, double scale)
{
    sbi_mg_work work;
    memset(&work, 0, sizeof work);
    work.m = m;
    work.matrix = matrix;
    work.scale = scale;
    m->softened = 0;
    m->deviation = 0;
    m->islands.ready = 0;
    for (int l = 0; l < m->level_count; l++) {
        int coarsest = l + 1 == m->level_count;
        work.level = m->levels + l;
        work.finer = l ? m->levels + l - 1 : NULL;
        sbi_mg_run(&work, l ? sbi_mg_gather_task : sbi_mg_diagonal_task);
        if (l)
            sbi_mg_run(&work, sbi_mg_complete_task);
        for (int t = 0; l == 0 && t < sbi_mg_tasks(work.level); t++)
            if (work.level->partial[t] >= 0)
                return (int)work.level->partial[t];
        if (work.level->packed)
            sbi_mg_run(&work, l ? sbi_mg_pack_task : sbi_mg_load_task);
        if (l == 0)
            sbi_mg_set_deviation(&work);
        if (work.level->mend)
            sbi_mg_run(&work, sbi_mg_mend_task);
        if (l == 0)
            sbi_mg_factor_islands(m, matrix, scale);
        if (!coarsest || !sbi_mg_factor_coarsest(m))
            sbi_mg_estimate_bound(&work, l ? NULL : &m->reach);
    }
    return -1;
}

/* ---- the cycle ----------------------------------------------------------------------------------------- */

/* Row i of what is left to the cycle: r_L - A_LI u_I, and 0 on islands. */
static sbi_float4 sbi_mg_left_by_islands(const sbi_mg_work *work, int i, sbi_float4 r)
{
    const sbi_mg_islands *islands = &work->m->islands;
    if (islands->side[i] == SBI_MG_ISLAND)
        return sbi_f4_make(0, 0, 0);
    if (islands->side[i] == SBI_MG_SHORE)
        return sbi_f4_sub(r, sbi_mg_multiply_row(work->level, i, islands->motion));
    return r;
}

/* r = in, and the first step of the smoother from 0: x = d = add D^-1 r. */
static void sbi_mg_begin_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    sbi_mg_level *level = work->level;
    for (int i = task * SBI_MG_ROWS; i < sbi_mg_end(level, task); i++) {
        float *r = level->r + 4 * (size_t)i, *d = level->d + 4 * (size_t)i, *x = level->x + 4 * (size_t)i;
        const sb_real *in = work->in + 3 * (size_t)i;
        sbi_float4 left = sbi_f4_make((float)(in[0] * work->factor), (float)(in[1] * work->factor),
                                      (float)(in[2] * work->factor)),
                   step;
        left = sbi_f4_scale(level->scale[4 * (size_t)i + 3], left);
        if (work->m->islands.ready)
            left = sbi_mg_left_by_islands(work, i, left);
        step = sbi_f4_scale(work->add, sbi_mg_relax(level->inverse + 12 * (size_t)i, left));
        sbi_f4_store(r, left);
        sbi_f4_store(d, step);
        sbi_f4_store(x, step);
    }
}

/* r = P^T r of the finer level, and the same first step. */
static void sbi_mg_restrict_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    sbi_mg_level *level = work->level;
    const sbi_mg_level *finer = work->finer;
    for (int a = task * SBI_MG_ROWS; a < sbi_mg_end(level, task); a++) {
        float *r = level->r + 4 * (size_t)a, *d = level->d + 4 * (size_t)a, *x = level->x + 4 * (size_t)a;
        sbi_float4 sum = sbi_f4_make(0, 0, 0), step;
        for (int c = finer->child_start[a]; c < finer->child_start[a + 1]; c++) {
            size_t i = 4 * (size_t)finer->children[c];
            sbi_float4 part = sbi_f4_scale(finer->child_shares[c], sbi_f4_load(finer->r + i));
            sum = sbi_f4_add(sum, finer->scale ? sbi_f4_mul(part, sbi_f4_load(finer->scale + i)) : part);
        }
        if (level->scale)
            sum = sbi_f4_scale(level->scale[4 * (size_t)a + 3], sum);
        step = sbi_f4_scale(work->add, sbi_mg_relax(level->inverse + 12 * (size_t)a, sum));
        sbi_f4_store(r, sum);
        sbi_f4_store(d, step);
        sbi_f4_store(x, step);
    }
}

/* The first step of the smoother from the x and r at hand. */
static void sbi_mg_again_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    sbi_mg_level *level = work->level;
    for (int i = task * SBI_MG_ROWS; i < sbi_mg_end(level, task); i++) {
        float *d = level->d + 4 * (size_t)i, *x = level->x + 4 * (size_t)i;
        const float *inverse = level->inverse + 12 * (size_t)i;
        sbi_float4 step = sbi_f4_scale(work->add, sbi_mg_relax(inverse, sbi_f4_load(level->r + 4 * (size_t)i)));
        sbi_f4_store(d, step);
        sbi_f4_store(x, sbi_f4_add(sbi_f4_load(x), step));
    }
}

/* e = P x of the coarser level: tasks of the finer one. */
static void sbi_mg_prolong_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    sbi_mg_level *level = work->level;
    const float *x = (level + 1)->x, *scales = (level + 1)->scale;
    for (int i = task * SBI_MG_ROWS; i < sbi_mg_end(level, task); i++) {
        sbi_float4 sum = sbi_f4_make(0, 0, 0);
        for (int p = level->parent_start[i]; p < level->parent_start[i + 1]; p++) {
            size_t a = 4 * (size_t)level->parents[p];
            float share = scales ? level->shares[p] * scales[a + 3] : level->shares[p];
            sum = sbi_f4_add(sum, sbi_f4_scale(share, sbi_f4_load(x + a)));
        }
        sbi_f4_store(level->e + 4 * (size_t)i,
                     level->scale ? sbi_f4_mul(sum, sbi_f4_load(level->scale + 4 * (size_t)i)) : sum);
    }
}

/* A step of the smoother: r -= A d, d' = keep d + add D^-1 r, x += d'. After a coarser level's solution, which is in e:
 * r -= A e, d' = add D^-1 r, x += e + d'. The last before a coarser level: r -= A d only. */
static void sbi_mg_step_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    sbi_mg_level *level = work->level;
    const int first_after = work->first_after;
    const float *from = first_after ? level->e : level->d, keep = work->keep, add = work->add;
    float *to = first_after ? level->d : level->e;
    for (int i = task * SBI_MG_ROWS; i < sbi_mg_end(level, task); i++) {
        float *r = level->r + 4 * (size_t)i, *x = level->x + 4 * (size_t)i;
        sbi_float4 own, next, left = sbi_f4_sub(sbi_f4_load(r), sbi_mg_multiply_row(level, i, from));
        sbi_f4_store(r, left);
        if (work->last)
            continue;
        own = sbi_f4_load(from + 4 * (size_t)i);
        next =
            sbi_f4_add(sbi_f4_scale(keep, own), sbi_f4_scale(add, sbi_mg_relax(level->inverse + 12 * (size_t)i, left)));
        sbi_f4_store(to + 4 * (size_t)i, next);
        sbi_f4_store(x, sbi_f4_add(sbi_f4_load(x), first_after ? sbi_f4_add(own, next) : next));
    }
}

static int sbi_mg_degree(const sbi_mg_work *work) { return work->level->degree + work->m->wide; }

/* Chebyshev's polynomial for eigenvalues from a twentieth of `bound` to it, by its three-term recurrence. Those of the
 * fourth kind (Lottes 2022) need no lower end, but take a tenth to a fifth more iterations; a tenth and a thirtieth are
 * worse than a twentieth. Eigenvalues do not grow up to 5 % beyond the bound, or 2.5 % with a fortieth.
 *
 * Near nu 0.5, rough motions that keep the volume cost little beside the others, and coarse levels do not see them.
 * There the polynomial goes down to a fortieth, with one step more: 11 and 29 iterations to 1e-2 and 1e-6 in place of
 * 14 and 35 (nu 0.49, tet10), in the same time. Neither does much without the other. */
static void sbi_mg_set_step(sbi_mg_work *work, int step)
{
    const double low = work->m->wide ? 1.0 / 40 : 1.0 / 20, twice_sigma = 2 * (1 + low) / (1 - low);
    double rho = 2 / twice_sigma, last = 0;
    for (int k = 0; k < step; k++) {
        last = rho;
        rho = 1 / (twice_sigma - last);
    }
    work->keep = (float)(rho * last);
    if (work->level->bound > 0)
        work->add = (float)((step ? 4 * rho / (1 - low) : 2 / (1 + low)) / work->level->bound);
    else
        work->add = 0; /* nothing to relax */
}

static void sbi_mg_steps(sbi_mg_work *work, int first, int last)
{
    for (int step = first; step < last; step++) {
        float *swap = work->level->d;
        sbi_mg_set_step(work, step);
        work->first_after = step == 0;
        sbi_mg_run(work, sbi_mg_step_task);
        if (work->first_after)
            continue;
        work->level->d = work->level->e;
        work->level->e = swap;
    }
    work->first_after = 0;
}

static void sbi_mg_residual(sbi_mg_work *work)
{
    work->last = 1;
    sbi_mg_run(work, sbi_mg_step_task);
    work->last = 0;
}

static void sbi_mg_cycle(sbi_mg_work *work, int l);

/* x = what the levels from l on find of A^-1 r, r being restricted from the level above or taken from outside. */
static void sbi_mg_solve_level(sbi_mg_work *work, int l)
{
    sbi_multigrid *m = work->m;
    work->level = m->levels + l;
    work->finer = l ? work->level - 1 : NULL;
    sbi_mg_set_step(work, 0);
    sbi_mg_run(work, l ? sbi_mg_restrict_task : sbi_mg_begin_task);
    if (l + 1 == m->level_count && m->factored) {
        sbi_mg_solve_coarsest(m);
        return;
    }
    sbi_mg_cycle(work, l);
    if (!work->level->twice)
        return;
    sbi_mg_residual(work);
    sbi_mg_set_step(work, 0);
    sbi_mg_run(work, sbi_mg_again_task);
    sbi_mg_cycle(work, l);
}

/* The rest of a V-cycle whose smoother has taken its first step. */
static void sbi_mg_cycle(sbi_mg_work *work, int l)
{
    sbi_multigrid *m = work->m;
    sbi_mg_steps(work, 1, sbi_mg_degree(work));
    if (l + 1 == m->level_count)
        return;
    sbi_mg_residual(work);
    sbi_mg_solve_level(work, l + 1);
    work->level = m->levels + l;
    sbi_mg_run(work, sbi_mg_prolong_task);
    sbi_mg_steps(work, 0, sbi_mg_degree(work));
}

static void sbi_mg_write_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    const sbi_mg_level *level = work->level;
    for (int i = task * SBI_MG_ROWS; i < sbi_mg_end(level, task); i++)
        for (size_t k = 0; k < 3; k++)
            work->out[3 * (size_t)i + k] =
                (sb_real)(level->x[4 * (size_t)i + k] * level->scale[4 * (size_t)i + 3]) * work->factor;
}

SBI_API void sbi_multigrid_apply(sbi_multigrid *m, const sb_real *r, sb_real scale, sb_real *z, sb_real back)
{
    sbi_mg_work work;
    memset(&work, 0, sizeof work);
    work.m = m;
    work.in = r;
    work.out = z;
    work.factor = scale;
    if (m->islands.ready)
        sbi_mg_leave_islands(m, r, scale);
    sbi_mg_solve_level(&work, 0);
    if (m->islands.ready)
        sbi_mg_reach_islands(m, r, scale);
    work.level = m->levels;
    work.factor = back;
    sbi_mg_run(&work, sbi_mg_write_task);
}

#if SBI_MG_WIDTH
#undef SBI_MG_FOUR_AT
#undef SBI_MG_PUT_FOUR
#endif
#if SBI_MG_WIDTH >= 256
#undef SBI_MG_EIGHT_AT
#undef SBI_MG_PUT_EIGHT
#undef SBI_MG_TURN
#endif
#undef SBI_MG_WIDTH
#undef SBI_MG_SSE
