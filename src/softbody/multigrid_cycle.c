/* multigrid_cycle: values of the levels, and the V-cycle. */
#include "multigrid_level.h"

#if defined(__GNUC__) && !defined(SB_NO_VECTORS) && defined(__AVX2__)
#include <immintrin.h>
#endif
#include <float.h>
#include <math.h>
#include <string.h>

/* ---- blocks of nine floats ----------------------------------------------------------------------------- */

/* Eight floats as one vector where the processor has them. Plain code beside it gives the same bits. */
#if defined(__GNUC__) && !defined(SB_NO_VECTORS) && defined(__AVX2__)
#define SBI_MG_WIDE 1
typedef float sbi_mg_eight __attribute__((vector_size(32), aligned(4), may_alias));
typedef float sbi_mg_four __attribute__((vector_size(16), aligned(4), may_alias));
#define SBI_MG_AT(pointer) (*(const sbi_mg_eight *)(const void *)(pointer))
#define SBI_MG_PUT(pointer, value) (*(sbi_mg_eight *)(void *)(pointer) = (value))
#define SBI_MG_TURN(v) \
    ((sbi_mg_eight)_mm256_permutevar8x32_ps((__m256)(v), _mm256_setr_epi32(0, 1, 2, 0, 1, 2, 0, 1)))
#else
#define SBI_MG_WIDE 0
#endif

/* to += factor from, nine floats. */
SBI_FORCE_INLINE void sbi_mg_add_block(float factor, const float *from, float *to)
{
#if SBI_MG_WIDE
    SBI_MG_PUT(to, SBI_MG_AT(to) + factor * SBI_MG_AT(from));
    to[8] += factor * from[8];
#else
    for (int k = 0; k < 9; k++)
        to[k] += factor * from[k];
#endif
}

/* Sums of a row of blocks times v: one for each place of the blocks, so that none waits for another and all forms of
 * the code give the same bits. The ninth place is the last lane of a vector that begins one float before x, y, z. */
#if SBI_MG_WIDE
SBI_FORCE_INLINE void sbi_mg_finish(sbi_mg_eight sum, sbi_mg_four last, float out[4])
{
    out[0] = sum[0] + sum[1] + sum[2];
    out[1] = sum[3] + sum[4] + sum[5];
    out[2] = sum[6] + sum[7] + last[3];
    out[3] = 0;
}

SBI_FORCE_INLINE void sbi_mg_sum_floats(const float *block, const int *column, const int *end, const float *v,
                                        float out[4])
{
    sbi_mg_eight sum = {0, 0, 0, 0, 0, 0, 0, 0};
    sbi_mg_four last = {0, 0, 0, 0};
    for (; column < end; column++, block += 9) {
        const float *from = v + 4 * (size_t)*column;
        sbi_mg_eight x = SBI_MG_AT(from);
        sum += SBI_MG_AT(block) * SBI_MG_TURN(x);
        last += *(const sbi_mg_four *)(const void *)(block + 5) * *(const sbi_mg_four *)(const void *)(from - 1);
    }
    sbi_mg_finish(sum, last, out);
}

/* sum += block times v, eight places of it and the ninth. Compilers do not find the first conversion by themselves. */
SBI_FORCE_INLINE void sbi_mg_add_packed(const int16_t *block, const float *from, sbi_mg_eight *sum, sbi_mg_four *last)
{
    __m256i eight = _mm256_cvtepi16_epi32(_mm_loadu_si128((const __m128i *)(const void *)block));
    __m128i four = _mm_cvtepi16_epi32(_mm_loadl_epi64((const __m128i *)(const void *)(block + 5)));
    sbi_mg_eight x = SBI_MG_AT(from);
    *sum += (sbi_mg_eight)_mm256_cvtepi32_ps(eight) * SBI_MG_TURN(x);
    *last += (sbi_mg_four)_mm_cvtepi32_ps(four) * *(const sbi_mg_four *)(const void *)(from - 1);
}

SBI_FORCE_INLINE void sbi_mg_sum_packed(const int16_t *block, const int *column, const int *end, const float *v,
                                        float out[4])
{
    sbi_mg_eight even = {0, 0, 0, 0, 0, 0, 0, 0}, odd = even;
    sbi_mg_four even_last = {0, 0, 0, 0}, odd_last = even_last;
    for (; column + 1 < end; column += 2, block += 18) {
        sbi_mg_add_packed(block, v + 4 * (size_t)column[0], &even, &even_last);
        sbi_mg_add_packed(block + 9, v + 4 * (size_t)column[1], &odd, &odd_last);
    }
    if (column < end)
        sbi_mg_add_packed(block, v + 4 * (size_t)column[0], &even, &even_last);
    sbi_mg_finish((even + odd) * (1 / SBI_MG_UNIT), (even_last + odd_last) * (1 / SBI_MG_UNIT), out);
}
#else
SBI_FORCE_INLINE void sbi_mg_finish(const float s[9], float factor, float out[4])
{
    for (int k = 0; k < 3; k++)
        out[k] = s[3 * k] * factor + s[3 * k + 1] * factor + s[3 * k + 2] * factor;
    out[3] = 0;
}

SBI_FORCE_INLINE void sbi_mg_sum_floats(const float *block, const int *column, const int *end, const float *v,
                                        float out[4])
{
    float s[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
    for (; column < end; column++, block += 9) {
        const float *from = v + 4 * (size_t)*column;
        for (int k = 0; k < 9; k++)
            s[k] += block[k] * from[k % 3];
    }
    sbi_mg_finish(s, 1, out);
}

SBI_FORCE_INLINE void sbi_mg_sum_packed(const int16_t *block, const int *column, const int *end, const float *v,
                                        float out[4])
{
    float s[2][9] = {{0, 0, 0, 0, 0, 0, 0, 0, 0}, {0, 0, 0, 0, 0, 0, 0, 0, 0}}; /* even and odd blocks */
    int odd = 0;
    for (; column < end; column++, block += 9, odd ^= 1) {
        const float *from = v + 4 * (size_t)*column;
        for (int k = 0; k < 9; k++)
            s[odd][k] += (float)block[k] * from[k % 3];
    }
    for (int k = 0; k < 9; k++)
        s[0][k] += s[1][k];
    sbi_mg_finish(s[0], 1 / SBI_MG_UNIT, out);
}
#endif

/* out = row i of A times v. */
SBI_FORCE_INLINE void sbi_mg_multiply_row(const sbi_mg_level *level, int i, const float *v, float out[4])
{
    const int *column = level->columns + level->row_start[i], *end = level->columns + level->row_start[i + 1];
    size_t first = 9 * (size_t)level->row_start[i];
    if (level->packed)
        sbi_mg_sum_packed(level->packed + first, column, end, v, out);
    else
        sbi_mg_sum_floats(level->blocks + first, column, end, v, out);
    if (level->mend) {
        const float *mend = level->mend + 12 * (size_t)i, *own = v + 4 * (size_t)i;
        for (int k = 0; k < 4; k++)
            out[k] += mend[k] * own[0] + mend[4 + k] * own[1] + mend[8 + k] * own[2]; /* symmetric */
    }
}

/* out = D_i^-1 v */
SBI_FORCE_INLINE void sbi_mg_relax(const float *inverse, const float *v, float out[4])
{
    for (int k = 0; k < 4; k++)
        out[k] = inverse[k] * v[0] + inverse[4 + k] * v[1] + inverse[8 + k] * v[2]; /* symmetric */
}

/* ---- tasks --------------------------------------------------------------------------------------------- */

/* What the tasks of one level see. */
typedef struct sbi_mg_work {
    sbi_multigrid *m;
    sbi_mg_level *level;      /* whose rows the tasks are, */
    sbi_mg_level *finer;      /* and the one above it or NULL */
    const sb_matrix *matrix;  /* of level 0, in updates */
    double scale;
    const sb_real *in;
    sb_real *out;
    sb_real factor;
    float keep, add;          /* of a Chebyshev step: d' = keep d + add D^-1 r */
    int first_after;          /* 1: the step after a coarser level's, whose motion is in e */
    int last;                 /* 1: only the residual is wanted */
    float alpha, beta;        /* of the estimate of the bound */
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
        for (int i = 0; i < 9; i++)
            if (keep && i / 3 != k && i % 3 != k)
                a[i] -= a[3 * (i / 3) + k] * a[3 * k + i % 3] / pivot;
        for (int i = 0; i < 3; i++)
            if (i != k) {
                a[3 * i + k] = keep ? a[3 * i + k] / pivot : 0;
                a[3 * k + i] = keep ? a[3 * k + i] / pivot : 0;
            }
        a[4 * k] = keep ? -1 / pivot : 0;
        kept += keep;
    }
    for (int k = 0; k < 12; k++)
        inverse[k] = k % 4 < 3 ? (float)-a[3 * (k / 4) + k % 4] : 0.0f;
    return kept;
}

/* S of a node of level 0, and the inverse of its scaled diagonal block; 0 when that is not positive definite. */
static int sbi_mg_load_diagonal(const sbi_mg_work *work, int i)
{
    const sbi_mg_level *level = work->level;
    const sb_real *block = work->matrix->blocks[level->diagonal[i]];
    float *scale = level->scale + 4 * (size_t)i, scaled[9];
    double largest = 0, inverse;
    for (int k = 0; k < 9; k += 4)
        largest = (double)block[k] > largest ? (double)block[k] : largest;
    if (!(largest > 0))
        return 0;
    largest *= work->scale;
    inverse = 1 / sqrt(largest);
    for (int k = 0; k < 3; k++)
        scale[k] = work->matrix->fixed[i] >> k & 1 ? 0.0f : (float)sqrt(largest);
    scale[3] = (float)inverse;
    for (int k = 0; k < 9; k++)
        scaled[k] = (float)((double)block[k] * work->scale / largest);
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

/* An entry times factor, rounded to the nearest; what a matrix that is not positive definite has beyond the range is
 * cut off. */
SBI_FORCE_INLINE int16_t sbi_mg_round(float entry, float factor)
{
    float x = entry * factor;
    x = x < SBI_MG_UNIT ? x : SBI_MG_UNIT; /* also where it is not a number */
    x = x > -SBI_MG_UNIT ? x : -SBI_MG_UNIT;
    return (int16_t)((int)(x + (SBI_MG_UNIT + 1.5f)) - 32768);
}

SBI_FORCE_INLINE void sbi_mg_pack(const float *block, float factor, int16_t *packed)
{
#if SBI_MG_WIDE
    __m256 x = _mm256_mul_ps(_mm256_loadu_ps(block), _mm256_set1_ps(factor));
    __m256i rounded;
    x = _mm256_max_ps(_mm256_min_ps(x, _mm256_set1_ps(SBI_MG_UNIT)), _mm256_set1_ps(-SBI_MG_UNIT));
    rounded = _mm256_cvttps_epi32(_mm256_add_ps(x, _mm256_set1_ps(SBI_MG_UNIT + 1.5f)));
    rounded = _mm256_sub_epi32(rounded, _mm256_set1_epi32(32768));
    _mm_storeu_si128((__m128i *)(void *)packed,
                     _mm_packs_epi32(_mm256_castsi256_si128(rounded), _mm256_extracti128_si256(rounded, 1)));
#else
    for (int k = 0; k < 8; k++)
        packed[k] = sbi_mg_round(block[k], factor);
#endif
    packed[8] = sbi_mg_round(block[8], factor);
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
    memset(level->mixed + 9 * (size_t)first, 0, 9 * (size_t)count * sizeof(float));
    mixer.parent_start = level->parent_start;
    mixer.shares = level->shares;
    mixer.slot = level->slots + level->slot_start[i];
    mixer.mixed = level->mixed;
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

/* Row i of level 0 from the matrix, and of its A P, in one pass over the matrix. The diagonal of prescribed components
 * does not reach the coarser level. */
static void sbi_mg_load_row(const sbi_mg_work *work, int i)
{
    const sbi_mg_level *level = work->level;
    const sb_real (*from)[9] = (const sb_real(*)[9])work->matrix->blocks;
    const sb_real scale = (sb_real)work->scale;
    const float *scales = level->scale, own = scales[4 * (size_t)i + 3];
    const int *columns = level->columns, last = level->row_start[i + 1], mixes = level->mixed != NULL;
    int16_t *packed = level->packed;
    sbi_mg_mixer mixer = {NULL, NULL, NULL, NULL};
    if (mixes)
        mixer = sbi_mg_begin_mixing(level, i);
    for (int q = level->row_start[i]; q < last; q++) {
        float block[9];
        int j = columns[q];
        sbi_mg_round_block(from[q], scale, block);
        sbi_mg_pack(block, (own * scales[4 * (size_t)j + 3]) * SBI_MG_UNIT, packed + 9 * (size_t)q);
        for (int k = 0; k < 9 && j == i; k++)
            block[k] = scales[4 * (size_t)i + (size_t)(k / 3)] > 0 ? block[k] : 0.0f;
        if (mixes)
            sbi_mg_mix(&mixer, j, block);
    }
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

/* Row a of P^T (A P), from the finer level. */
static void sbi_mg_gather_row(const sbi_mg_level *level, const sbi_mg_level *finer, int a)
{
    const int *target = finer->targets + finer->target_start[a];
    int first = level->row_start[a], last = level->row_start[a + 1];
    const float *mixed = finer->mixed;
    float *blocks = level->blocks;
    memset(blocks + 9 * (size_t)first, 0, 9 * (size_t)(last - first) * sizeof(float));
    for (int c = finer->child_start[a]; c < finer->child_start[a + 1]; c++) {
        int i = finer->children[c], end = finer->mixed_start[i + 1];
        float share = finer->child_shares[c];
        for (int s = finer->mixed_start[i]; s < end; s++)
            sbi_mg_add_block(share, mixed + 9 * (size_t)s, blocks + 9 * (size_t)*target++);
    }
}

static void sbi_mg_load_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    for (int i = task * SBI_MG_ROWS; i < sbi_mg_end(work->level, task); i++)
        sbi_mg_load_row(work, i);
}

/* Where moduli jump by 1,000, the motion of a stiff part as a whole costs so little that the rounding of its rows to 16
 * bits is felt: without this six slabs take one or two iterations more of eight. What the blocks of row i lose of a
 * translation is added to the diagonal block. */
static void sbi_mg_mend_row(const sbi_mg_work *work, int i)
{
    const sbi_mg_level *level = work->level;
    const double own = (double)level->scale[4 * (size_t)i + 3], exact = work->scale * own * own;
    double lost[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
    for (int q = level->row_start[i]; q < level->row_start[i + 1]; q++) {
        const sb_real *from = work->matrix->blocks[q];
        const int16_t *packed = level->packed + 9 * (size_t)q;
        double unit = own / ((double)level->scale[4 * (size_t)level->columns[q] + 3] * (double)SBI_MG_UNIT);
        for (int k = 0; k < 9; k++)
            lost[k] += (double)from[k] * exact - packed[k] * unit;
    }
    for (int k = 0; k < 9; k++)
        level->mend[12 * (size_t)i + (size_t)(4 * (k / 3) + k % 3)] = (float)((lost[k] + lost[3 * (k % 3) + k / 3]) / 2);
}

static void sbi_mg_mend_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    for (int i = task * SBI_MG_ROWS; i < sbi_mg_end(work->level, task); i++)
        sbi_mg_mend_row(work, i);
}

/* Rows of a coarser level with all that the next one needs of them. */
static void sbi_mg_gather_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    const sbi_mg_level *level = work->level;
    for (int a = task * SBI_MG_ROWS; a < sbi_mg_end(level, task); a++) {
        sbi_mg_gather_row(level, work->finer, a);
        sbi_mg_invert(level->blocks + 9 * (size_t)level->diagonal[a], level->inverse + 12 * (size_t)a);
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
            if (level->blocks)
                r[k] *= level->blocks[9 * (size_t)level->diagonal[i] + 4 * (size_t)k];
        }
        r[3] = d[3] = 0;
        sbi_mg_relax(level->inverse + 12 * (size_t)i, r, d);
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
        sbi_mg_multiply_row(level, i, level->d, e);
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
        sbi_mg_relax(level->inverse + 12 * (size_t)i, r, x);
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

/* Eigenvalues of D^-1 A from above, but for bad luck: Lanczos steps as conjugate gradients take them, and a margin.
 * Five steps come within 12 % of the largest eigenvalue of solids' matrices, within 20 % where there are slivers; on
 * coarser levels of regions they miss up to a third, twelve a few per cent. */
static void sbi_mg_estimate_bound(sbi_mg_work *work)
{
    enum { FEW = 5, MANY = 12 };
    sbi_mg_level *level = work->level;
    double diagonal[MANY], side[MANY], rz, last_alpha = 0, last_beta = 0;
    int steps = 0, most = work->m->regions.count > 0 && work->finer ? MANY : FEW;
    sbi_mg_run(work, sbi_mg_bound_begin_task);
    rz = sbi_mg_sum(level);
    while (steps < most && rz > 0) {
        double curvature, alpha, next;
        sbi_mg_run(work, sbi_mg_bound_product_task);
        curvature = sbi_mg_sum(level);
        if (!(curvature > 0))
            break;
        alpha = rz / curvature;
        work->alpha = (float)alpha;
        sbi_mg_run(work, sbi_mg_bound_residual_task);
        next = sbi_mg_sum(level);
        diagonal[steps] = 1 / alpha + (steps ? last_beta / last_alpha : 0);
        last_beta = next / rz;
        last_alpha = alpha;
        side[steps] = next > 0 ? sqrt(last_beta) / alpha : 0;
        rz = next;
        work->beta = (float)last_beta;
        if (++steps < most)
            sbi_mg_run(work, sbi_mg_bound_direction_task);
    }
    level->bound = steps ? (most == FEW ? 1.3 : 1.2) * sbi_mg_largest_eigenvalue(diagonal, side, steps) : 1;
}

/* ---- the coarsest level -------------------------------------------------------------------------------- */

/* Cholesky factor R^T R in the upper triangle; directions without stiffness are left out. */
static void sbi_mg_factor_dense(sbi_multigrid *m)
{
    const sbi_mg_level *level = m->levels + m->level_count - 1;
    size_t n = (size_t)m->dense;
    double *a = m->factor;
    memset(a, 0, n * n * sizeof(double));
    for (int i = 0; i < level->row_count; i++)
        for (int q = level->row_start[i]; q < level->row_start[i + 1]; q++)
            for (size_t k = 0; k < 9; k++)
                a[(3 * (size_t)i + k / 3) * n + 3 * (size_t)level->columns[q] + k % 3] =
                    (double)level->blocks[9 * (size_t)q + k];
    for (size_t k = 0; k < n; k++) /* single precision: what is smaller is rounding */
        m->solution[k] = 16 * (double)FLT_EPSILON * a[k * n + k];
    for (size_t k = 0; k < n; k++) {
        double *row = a + k * n, pivot = row[k];
        m->pivot[k] = pivot > 0 && pivot > m->solution[k] ? 1 / sqrt(pivot) : 0;
        for (size_t j = k; j < n; j++)
            row[j] *= m->pivot[k];
        for (size_t i = k + 1; i < n; i++) {
            double *other = a + i * n, factor = row[i];
            if (factor == 0)
                continue;
            for (size_t j = i; j < n; j++)
                other[j] -= factor * row[j];
        }
    }
}

/* x = A^-1 r of the coarsest level. */
static void sbi_mg_solve_dense(sbi_multigrid *m)
{
    const sbi_mg_level *level = m->levels + m->level_count - 1;
    size_t n = (size_t)m->dense;
    double *v = m->solution;
    for (size_t k = 0; k < n; k++)
        v[k] = (double)level->r[4 * (k / 3) + k % 3];
    for (size_t k = 0; k < n; k++) {
        const double *row = m->factor + k * n;
        double value = v[k] *= m->pivot[k];
        for (size_t j = k + 1; j < n; j++)
            v[j] -= value * row[j];
    }
    for (size_t k = n; k-- > 0;) {
        const double *row = m->factor + k * n;
        double sums[4] = {0, 0, 0, 0}, value = v[k];
        size_t j = k + 1;
        for (; j + 4 <= n; j += 4)
            for (size_t lane = 0; lane < 4; lane++)
                sums[lane] += row[j + lane] * v[j + lane];
        for (; j < n; j++)
            sums[0] += row[j] * v[j];
        value -= (sums[0] + sums[1]) + (sums[2] + sums[3]);
        v[k] = value * m->pivot[k];
    }
    for (size_t k = 0; k < n; k++)
        level->x[4 * (k / 3) + k % 3] = (float)v[k];
}

SBI_API int sbi_multigrid_soften(sbi_multigrid *m)
{
    if (m->softened == 6)
        return 0;
    m->softened++;
    for (int l = 0; l < m->level_count; l++)
        m->levels[l].bound *= 2;
    return 1;
}

SBI_API int sbi_multigrid_update(sbi_multigrid *m, const sb_matrix *matrix, double scale)
{
    sbi_mg_work work;
    memset(&work, 0, sizeof work);
    work.m = m;
    work.matrix = matrix;
    work.scale = scale;
    m->softened = 0;
    for (int l = 0; l < m->level_count; l++) {
        int coarsest = l + 1 == m->level_count;
        work.level = m->levels + l;
        work.finer = l ? m->levels + l - 1 : NULL;
        sbi_mg_run(&work, l ? sbi_mg_gather_task : sbi_mg_diagonal_task);
        for (int t = 0; l == 0 && t < sbi_mg_tasks(work.level); t++)
            if (work.level->partial[t] >= 0)
                return (int)work.level->partial[t];
        if (l == 0)
            sbi_mg_run(&work, sbi_mg_load_task);
        if (work.level->mend)
            sbi_mg_run(&work, sbi_mg_mend_task);
        if (!coarsest || !m->dense)
            sbi_mg_estimate_bound(&work);
    }
    if (m->dense)
        sbi_mg_factor_dense(m);
    return -1;
}

/* ---- the cycle ----------------------------------------------------------------------------------------- */

/* r = in, and the first step of the smoother from 0: x = d = add D^-1 r. */
static void sbi_mg_begin_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    sbi_mg_level *level = work->level;
    for (int i = task * SBI_MG_ROWS; i < sbi_mg_end(level, task); i++) {
        float *r = level->r + 4 * (size_t)i, *d = level->d + 4 * (size_t)i, *x = level->x + 4 * (size_t)i, z[4];
        for (size_t k = 0; k < 3; k++)
            r[k] = (float)(work->in[3 * (size_t)i + k] * work->factor) * level->scale[4 * (size_t)i + 3];
        sbi_mg_relax(level->inverse + 12 * (size_t)i, r, z);
        for (int k = 0; k < 4; k++)
            x[k] = d[k] = work->add * z[k];
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
        float sum[4] = {0, 0, 0, 0}, z[4];
        for (int c = finer->child_start[a]; c < finer->child_start[a + 1]; c++) {
            size_t i = 4 * (size_t)finer->children[c];
            float share = finer->child_shares[c];
            for (size_t k = 0; k < 4; k++)
                sum[k] += share * finer->r[i + k] * (finer->scale ? finer->scale[i + k] : 1.0f);
        }
        sbi_mg_relax(level->inverse + 12 * (size_t)a, sum, z);
        for (int k = 0; k < 4; k++) {
            r[k] = sum[k];
            x[k] = d[k] = work->add * z[k];
        }
    }
}

/* The first step of the smoother from the x and r at hand. */
static void sbi_mg_again_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    sbi_mg_level *level = work->level;
    for (int i = task * SBI_MG_ROWS; i < sbi_mg_end(level, task); i++) {
        float *d = level->d + 4 * (size_t)i, *x = level->x + 4 * (size_t)i, z[4];
        sbi_mg_relax(level->inverse + 12 * (size_t)i, level->r + 4 * (size_t)i, z);
        for (int k = 0; k < 4; k++) {
            d[k] = work->add * z[k];
            x[k] += d[k];
        }
    }
}

/* e = P x of the coarser level: tasks of the finer one. */
static void sbi_mg_prolong_task(void *user, int task)
{
    const sbi_mg_work *work = (const sbi_mg_work *)user;
    sbi_mg_level *level = work->level;
    const float *x = (level + 1)->x;
    for (int i = task * SBI_MG_ROWS; i < sbi_mg_end(level, task); i++) {
        float sum[4] = {0, 0, 0, 0};
        for (int p = level->parent_start[i]; p < level->parent_start[i + 1]; p++)
            for (size_t k = 0; k < 4; k++)
                sum[k] += level->shares[p] * x[4 * (size_t)level->parents[p] + k];
        for (size_t k = 0; k < 4; k++)
            level->e[4 * (size_t)i + k] = sum[k] * (level->scale ? level->scale[4 * (size_t)i + k] : 1.0f);
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
        float *r = level->r + 4 * (size_t)i, *x = level->x + 4 * (size_t)i, product[4], z[4];
        const float *own = from + 4 * (size_t)i;
        float *next = to + 4 * (size_t)i;
        sbi_mg_multiply_row(level, i, from, product);
        for (int k = 0; k < 4; k++)
            r[k] -= product[k];
        if (work->last)
            continue;
        sbi_mg_relax(level->inverse + 12 * (size_t)i, r, z);
        for (int k = 0; k < 4; k++) {
            next[k] = keep * own[k] + add * z[k];
            x[k] += first_after ? own[k] + next[k] : next[k];
        }
    }
}

/* Chebyshev's polynomial for eigenvalues from a twentieth of `bound` to it, by its three-term recurrence. Those of the
 * fourth kind (Lottes 2022) need no lower end, but take a tenth to a fifth more iterations; a tenth and a thirtieth are
 * worse than a twentieth. Eigenvalues up to 6 % beyond the bound are still reduced. */
static void sbi_mg_set_step(sbi_mg_work *work, int step)
{
    const double low = 1.0 / 20, twice_sigma = 2 * (1 + low) / (1 - low);
    double rho = 2 / twice_sigma, last = 0;
    for (int k = 0; k < step; k++) {
        last = rho;
        rho = 1 / (twice_sigma - last);
    }
    work->keep = (float)(rho * last);
    work->add = (float)((step ? 4 * rho / (1 - low) : 2 / (1 + low)) / work->level->bound);
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

/* x = what the levels from l on find of A^-1 r, r being restricted from the level above or taken from outside. Coarser
 * levels, which cost little, go through their cycle twice. */
static void sbi_mg_solve_level(sbi_mg_work *work, int l)
{
    sbi_multigrid *m = work->m;
    work->level = m->levels + l;
    work->finer = l ? work->level - 1 : NULL;
    sbi_mg_set_step(work, 0);
    sbi_mg_run(work, l ? sbi_mg_restrict_task : sbi_mg_begin_task);
    if (l + 1 == m->level_count && m->dense) {
        sbi_mg_solve_dense(m);
        return;
    }
    sbi_mg_cycle(work, l);
    if (l < m->twice_from)
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
    sbi_mg_steps(work, 1, m->degree);
    if (l + 1 == m->level_count)
        return;
    sbi_mg_residual(work);
    sbi_mg_solve_level(work, l + 1);
    work->level = m->levels + l;
    sbi_mg_run(work, sbi_mg_prolong_task);
    sbi_mg_steps(work, 0, m->degree);
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
    sbi_mg_solve_level(&work, 0);
    work.level = m->levels;
    work.factor = back;
    sbi_mg_run(&work, sbi_mg_write_task);
}

#if SBI_MG_WIDE
#undef SBI_MG_AT
#undef SBI_MG_PUT
#undef SBI_MG_TURN
#endif
#undef SBI_MG_WIDE
