/* precond_fsai: see precond_fsai.h. */
#include "precond_fsai.h"

#include <float.h>
#include <limits.h>
#include <math.h>
#include <string.h>

#include "../base/float4.h"

/* ---- the pattern --------------------------------------------------------------------------------------- */

/* Shell's sort with Ciura's gaps: rows are short, and partly in order. */
static void sbi_fsai_sort(int *values, int count)
{
    static const int gaps[] = {1750, 701, 301, 132, 57, 23, 10, 4, 1};
    for (int g = 0; g < (int)(sizeof gaps / sizeof *gaps); g++)
        for (int k = gaps[g]; k < count; k++) {
            int value = values[k], at = k;
            for (; at >= gaps[g] && values[at - gaps[g]] > value; at -= gaps[g])
                values[at] = values[at - gaps[g]];
            values[at] = value;
        }
}

/* Columns j <= i of row i of |A|^power in order, i last; returns their number. mark [row_count] holds i for no node;
 * seen [row_count] is scratch. */
static int sbi_fsai_row(const sb_matrix *a, int power, int i, int *mark, int *seen)
{
    int count = 1, first = 0, kept = 0;
    seen[0] = i;
    mark[i] = i;
    for (int level = 0; level < power; level++) { /* all neighbours of those that the last level found */
        int last = count;
        for (; first < last; first++)
            for (int q = a->row_start[seen[first]]; q < a->row_end[seen[first]]; q++) {
                int j = a->columns[q];
                if (mark[j] == i)
                    continue;
                mark[j] = i;
                seen[count++] = j;
            }
    }
    for (int k = 0; k < count; k++)
        if (seen[k] <= i)
            seen[kept++] = seen[k];
    sbi_fsai_sort(seen, kept);
    return kept;
}

/* start[row_count + 1] of the rows; returns the number of blocks, or 0 when that is more than INT_MAX. */
static size_t sbi_fsai_count(const sb_matrix *a, int power, int *start, int *mark, int *seen)
{
    size_t total = 0;
    for (int i = 0; i < a->row_count; i++)
        mark[i] = -1;
    for (int i = 0; i < a->row_count; i++) {
        start[i] = (int)total;
        total += (size_t)sbi_fsai_row(a, power, i, mark, seen);
        if (total > INT_MAX)
            return 0;
    }
    start[a->row_count] = (int)total;
    return total;
}

static void sbi_fsai_fill(sbi_fsai *f, const sb_matrix *a, int *mark, int *seen)
{
    for (int i = 0; i < a->row_count; i++)
        mark[i] = -1;
    memset(f->end, 0, ((size_t)f->row_count + 1) * sizeof(int));
    for (int i = 0; i < f->row_count; i++) {
        int count = sbi_fsai_row(a, f->power, i, mark, seen);
        memcpy(f->columns + f->start[i], seen, (size_t)count * sizeof(int));
        for (int k = 0; k < count; k++)
            f->end[seen[k] + 1]++;
    }
    for (int j = 0; j < f->row_count; j++) {
        f->end[j + 1] += f->end[j];
        mark[j] = f->end[j];
    }
    for (int i = 0; i < f->row_count; i++)
        for (int e = f->start[i]; e < f->start[i + 1]; e++) {
            f->back[e] = mark[f->columns[e]]++;
            f->members[f->back[e]] = i;
        }
}

/* ---- tasks and their scratch --------------------------------------------------------------------------- */

/* Floats of a row of the scratch matrix of `nodes` nodes: whole cache lines. */
static size_t sbi_fsai_stride(size_t nodes) { return (3 * nodes + 15) / 16 * 16; }

/* The matrix, the scales of its rows, and the three rows of L^-1 as columns. */
static size_t sbi_fsai_scratch(size_t nodes) { return sbi_fsai_stride(nodes) * (3 * nodes + 1 + 4); }

static size_t sbi_fsai_row_nodes(const int *start, int i) { return (size_t)(start[i + 1] - start[i]); }

/* Work of a row, up to a factor: of the factorisation and of looking up its blocks. */
static double sbi_fsai_work(const int *start, int i)
{
    double nodes = (double)sbi_fsai_row_nodes(start, i);
    return nodes * nodes * (nodes + 30);
}

/* Cuts the rows into tasks of about equal work; returns the floats of scratch of all, or 0 for more than a size_t
 * holds. */
static size_t sbi_fsai_cut(const int *start, int rows, int *task_row, size_t *task_scratch)
{
    double total = 0, done = 0;
    size_t scratch = 0;
    int i = 0;
    for (int k = 0; k < rows; k++)
        total += sbi_fsai_work(start, k);
    for (int task = 0; task < SBI_FSAI_TASKS; task++) {
        size_t longest = 1;
        task_row[task] = i;
        task_scratch[task] = scratch;
        for (; i < rows && (done * (double)SBI_FSAI_TASKS < total * (task + 1) || task == SBI_FSAI_TASKS - 1); i++) {
            size_t nodes = sbi_fsai_row_nodes(start, i);
            longest = nodes > longest ? nodes : longest;
            done += sbi_fsai_work(start, i);
        }
        if (longest > (size_t)1 << 14 || !sbi_size_add(&scratch, sbi_fsai_scratch(longest), 1))
            return 0;
    }
    task_row[SBI_FSAI_TASKS] = rows;
    return scratch;
}

/* ---- life ---------------------------------------------------------------------------------------------- */

static void sbi_fsai_layout(sbi_fsai *f, size_t scratch, sbi_arena *arena)
{
    size_t rows = (size_t)f->row_count, entries = (size_t)f->entry_count;
    f->start = (int *)sbi_arena_take(arena, rows + 1, sizeof(int));
    f->end = (int *)sbi_arena_take(arena, rows + 1, sizeof(int));
    f->columns = (int *)sbi_arena_take(arena, entries, sizeof(int));
    f->back = (int *)sbi_arena_take(arena, entries, sizeof(int));
    f->members = (int *)sbi_arena_take(arena, entries, sizeof(int));
    f->rows = (float *)sbi_arena_take(arena, entries, 12 * sizeof(float));
    f->turned = (float *)sbi_arena_take(arena, entries, 12 * sizeof(float));
    f->task_row = (int *)sbi_arena_take(arena, SBI_FSAI_TASKS + 1, sizeof(int));
    f->task_scratch = (size_t *)sbi_arena_take(arena, SBI_FSAI_TASKS, sizeof(size_t));
    f->bad = (int *)sbi_arena_take(arena, SBI_FSAI_TASKS, sizeof(int));
    f->shifts = (double *)sbi_arena_take(arena, SBI_FSAI_TASKS, sizeof(double));
    f->scratch = (float *)sbi_arena_take(arena, scratch, sizeof(float));
}

/* Takes the memory of *f, whose sizes are known. */
static int sbi_fsai_take(sbi_fsai *f, size_t scratch, const sb_allocator *allocator)
{
    sbi_arena arena = {NULL, 0, 0};
    sbi_fsai_layout(f, scratch, &arena);
    if (arena.overflow || arena.used > (size_t)-1 - 64)
        return 0;
    f->bytes = arena.used + 64;
    f->memory = sbi_alloc(allocator, f->bytes, 1);
    if (!f->memory)
        return 0;
    arena.base = (unsigned char *)f->memory + (64 - (uintptr_t)f->memory % 64) % 64;
    arena.used = 0;
    sbi_fsai_layout(f, scratch, &arena);
    return 1;
}

SBI_API sb_result sbi_fsai_create(const sb_matrix *pattern, int power, const sb_allocator *allocator, sbi_fsai *fsai)
{
    size_t rows = (size_t)pattern->row_count, entries, scratch = 0;
    int *work = (int *)sbi_alloc(allocator, 3 * rows + 1, sizeof(int)), *mark = work, *seen = work + rows;
    int *start = work + 2 * rows, task_row[SBI_FSAI_TASKS + 1], made = 0;
    size_t task_scratch[SBI_FSAI_TASKS];
    sbi_fsai f;
    if (!work)
        return SB_ERROR_MEMORY;
    memset(&f, 0, sizeof f);
    f.row_count = pattern->row_count;
    f.power = power;
    entries = sbi_fsai_count(pattern, power, start, mark, seen);
    if (entries > 0)
        scratch = sbi_fsai_cut(start, f.row_count, task_row, task_scratch);
    if (scratch > 0) {
        f.entry_count = (int)entries;
        made = sbi_fsai_take(&f, scratch, allocator);
    }
    if (made) {
        memcpy(f.start, start, (rows + 1) * sizeof(int));
        memcpy(f.task_row, task_row, sizeof task_row);
        memcpy(f.task_scratch, task_scratch, sizeof task_scratch);
        sbi_fsai_fill(&f, pattern, mark, seen);
        *fsai = f;
    }
    sbi_free(allocator, work);
    return made ? SB_OK : SB_ERROR_MEMORY;
}

SBI_API void sbi_fsai_free(const sb_allocator *allocator, sbi_fsai *fsai)
{
    sbi_free(allocator, fsai->memory);
    memset(fsai, 0, sizeof *fsai);
}

/* ---- one row ------------------------------------------------------------------------------------------- */

enum { SBI_FSAI_LANES = 8 };
#if SBI_HAS_FLOAT4
typedef float sbi_float8 __attribute__((vector_size(32), may_alias));
#endif

/* The dense upper triangle of A_JJ, scaled to a unit diagonal: [size][stride] floats, scales [size]. What is left of
 * each row's diagonal is never read for a result. */
typedef struct sbi_fsai_dense {
    int size;
    size_t stride;
    float *matrix, *scales;
    float *inverse; /* [size][4] the last three rows of L^-1, by columns */
} sbi_fsai_dense;

static sbi_fsai_dense sbi_fsai_dense_at(float *scratch, size_t nodes)
{
    sbi_fsai_dense d;
    d.size = (int)(3 * nodes);
    d.stride = sbi_fsai_stride(nodes);
    d.matrix = scratch;
    d.scales = scratch + d.stride * 3 * nodes;
    d.inverse = d.scales + d.stride;
    return d;
}

/* 1, or 0 when a diagonal entry is not positive. */
static int sbi_fsai_scales(const sb_matrix *a, const int *nodes, double scale, sbi_fsai_dense *d)
{
    for (int k = 0; k < d->size; k++) {
        float entry = sbi_precond_in_range((double)a->blocks[a->diagonal[nodes[k / 3]]][4 * (k % 3)] * scale);
        if (!(entry > 0 && entry <= FLT_MAX))
            return 0;
        d->scales[k] = 1 / sqrtf(entry);
    }
    return 1;
}

static void sbi_fsai_place(const sb_real *block, double scale, const sbi_fsai_dense *d, int row, int column)
{
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++)
            d->matrix[(size_t)(3 * row + r) * d->stride + (size_t)(3 * column + c)] =
                (float)((double)block[3 * r + c] * scale) * d->scales[3 * row + r] * d->scales[3 * column + c];
}

/* The blocks of A that join the nodes, which ascend, above the diagonal; the rest is 0. */
static void sbi_fsai_gather(const sb_matrix *a, const int *nodes, double scale, double shift, const sbi_fsai_dense *d)
{
    int count = d->size / 3;
    memset(d->matrix, 0, (size_t)d->size * d->stride * sizeof(float));
    for (int row = 0; row < count; row++) {
        int column = row, q = a->diagonal[nodes[row]], end = a->row_end[nodes[row]];
        while (q < end && column < count) {
            if (a->columns[q] == nodes[column])
                sbi_fsai_place(a->blocks[q++], scale, d, row, column++);
            else if (a->columns[q] < nodes[column])
                q++;
            else
                column++;
        }
    }
    for (int k = 0; k < d->size; k++)
        d->matrix[(size_t)k * d->stride + (size_t)k] = (float)(1 + shift);
}

/* to[from..size) -= f[0] rows[0] + ... of `count` rows, in whole vectors. */
SBI_FORCE_INLINE void sbi_fsai_eliminate(float *to, const float *rows, size_t stride, const float *f, int count,
                                         int from, int size)
{
    for (int j = from - from % SBI_FSAI_LANES; j < size; j += SBI_FSAI_LANES) {
#if SBI_HAS_FLOAT4
        sbi_float8 sum = *(const sbi_float8 *)(const void *)(to + j);
        for (int k = 0; k < count; k++)
            sum -= f[k] * *(const sbi_float8 *)(const void *)(rows + (size_t)k * stride + j);
        *(sbi_float8 *)(void *)(to + j) = sum;
#else
        for (int k = 0; k < count; k++)
            for (int lane = 0; lane < SBI_FSAI_LANES; lane++)
                to[j + lane] -= f[k] * rows[(size_t)k * stride + (size_t)(j + lane)];
#endif
    }
}

/* Rows first .. first + count - 1 of the factor R (R^T R = A_JJ), and their part of the rows below. 0 when a pivot is
 * lost. */
SBI_FORCE_INLINE int sbi_fsai_factor_rows(const sbi_fsai_dense *d, int first, int count)
{
    const float least = 64 * FLT_EPSILON; /* of a unit diagonal */
    float *rows = d->matrix + (size_t)first * d->stride;
    for (int k = 0; k < count; k++) {
        float *row = rows + (size_t)k * d->stride, pivot = row[first + k], factor;
        if (!(pivot > least && pivot <= FLT_MAX))
            return 0;
        factor = 1 / sqrtf(pivot);
        for (int j = first + k; j < d->size; j++)
            row[j] *= factor;
        for (int i = k + 1; i < count; i++)
            sbi_fsai_eliminate(rows + (size_t)i * d->stride, row, d->stride, row + first + i, 1, first + i, d->size);
    }
    for (int i = first + count; i < d->size; i++) {
        float f[6];
        for (int k = 0; k < count; k++)
            f[k] = rows[(size_t)k * d->stride + (size_t)i];
        sbi_fsai_eliminate(d->matrix + (size_t)i * d->stride, rows, d->stride, f, count, i, d->size);
    }
    return 1;
}

static int sbi_fsai_factor(const sbi_fsai_dense *d)
{
    int first = d->size % 6;
    if (first && !sbi_fsai_factor_rows(d, 0, 3))
        return 0;
    for (; first < d->size; first += 6)
        if (!sbi_fsai_factor_rows(d, first, 6))
            return 0;
    return 1;
}

/* Columns of the last three rows of L^-1: R y = e for the three last unit vectors at once, from below. */
static void sbi_fsai_substitute(const sbi_fsai_dense *d)
{
    for (int k = d->size - 1; k >= 0; k--) {
        const float *row = d->matrix + (size_t)k * d->stride;
        sbi_float4 s0 = sbi_f4_make(0, 0, 0), s1 = s0, s2 = s0, s3 = s0, unit = s0;
        int l = k + 1;
        if (k >= d->size - 3)
            SBI_F4(unit, k - (d->size - 3)) = 1;
        for (; l + 4 <= d->size; l += 4) {
            const float *y = d->inverse + 4 * (size_t)l;
            s0 = sbi_f4_add(s0, sbi_f4_scale(row[l], sbi_f4_load(y)));
            s1 = sbi_f4_add(s1, sbi_f4_scale(row[l + 1], sbi_f4_load(y + 4)));
            s2 = sbi_f4_add(s2, sbi_f4_scale(row[l + 2], sbi_f4_load(y + 8)));
            s3 = sbi_f4_add(s3, sbi_f4_scale(row[l + 3], sbi_f4_load(y + 12)));
        }
        for (; l < d->size; l++)
            s0 = sbi_f4_add(s0, sbi_f4_scale(row[l], sbi_f4_load(d->inverse + 4 * (size_t)l)));
        s0 = sbi_f4_sub(unit, sbi_f4_add(sbi_f4_add(s0, s1), sbi_f4_add(s2, s3)));
        sbi_f4_store(d->inverse + 4 * (size_t)k, sbi_f4_scale(1 / row[k], s0));
    }
}

/* Row i of G, from the inverse of the scaled factor, to both its places. */
static void sbi_fsai_store(sbi_fsai *f, int i, const sbi_fsai_dense *d)
{
    for (int e = f->start[i], k = 0; e < f->start[i + 1]; e++, k += 3) {
        float *row = f->rows + 12 * (size_t)e, *turned = f->turned + 12 * (size_t)f->back[e];
        sbi_float4 c0 = sbi_f4_scale(d->scales[k], sbi_f4_load(d->inverse + 4 * (size_t)k));
        sbi_float4 c1 = sbi_f4_scale(d->scales[k + 1], sbi_f4_load(d->inverse + 4 * (size_t)k + 4));
        sbi_float4 c2 = sbi_f4_scale(d->scales[k + 2], sbi_f4_load(d->inverse + 4 * (size_t)k + 8));
        sbi_f4_store(row, c0);
        sbi_f4_store(row + 4, c1);
        sbi_f4_store(row + 8, c2);
        for (int r = 0; r < 3; r++)
            sbi_f4_store(turned + 4 * r, sbi_f4_make(SBI_F4(c0, r), SBI_F4(c1, r), SBI_F4(c2, r)));
    }
}

/* ---- update -------------------------------------------------------------------------------------------- */

typedef struct sbi_fsai_job {
    sbi_fsai *fsai;
    const sb_matrix *a;
    double scale, most;
} sbi_fsai_job;

/* 1, or 0 when no shift up to job->most helps. */
static int sbi_fsai_make_row(const sbi_fsai_job *job, int i, float *scratch, double *largest)
{
    sbi_fsai *f = job->fsai;
    const int *nodes = f->columns + f->start[i];
    sbi_fsai_dense d = sbi_fsai_dense_at(scratch, sbi_fsai_row_nodes(f->start, i));
    double shift = 0;
    if (!sbi_fsai_scales(job->a, nodes, job->scale, &d))
        return 0;
    for (;; shift = shift > 0 ? 2 * shift : 1e-3) {
        if (shift > job->most)
            return 0;
        sbi_fsai_gather(job->a, nodes, job->scale, shift, &d);
        if (sbi_fsai_factor(&d))
            break;
    }
    sbi_fsai_substitute(&d);
    sbi_fsai_store(f, i, &d);
    *largest = shift > *largest ? shift : *largest;
    return 1;
}

static void sbi_fsai_task(void *user, int task)
{
    const sbi_fsai_job *job = (const sbi_fsai_job *)user;
    sbi_fsai *f = job->fsai;
    f->bad[task] = -1;
    f->shifts[task] = 0;
    for (int i = f->task_row[task]; i < f->task_row[task + 1] && f->bad[task] < 0; i++)
        if (!sbi_fsai_make_row(job, i, f->scratch + f->task_scratch[task], f->shifts + task))
            f->bad[task] = i;
}

SBI_API int sbi_fsai_update(sbi_fsai *fsai, const sb_matrix *a, double scale, double most, const sb_jobs *jobs,
                            double *shift)
{
    sbi_fsai_job job;
    job.fsai = fsai;
    job.a = a;
    job.scale = scale;
    job.most = most;
    sbi_run(jobs, sbi_fsai_task, &job, SBI_FSAI_TASKS);
    *shift = 0;
    for (int task = 0; task < SBI_FSAI_TASKS; task++) {
        *shift = fsai->shifts[task] > *shift ? fsai->shifts[task] : *shift;
        if (fsai->bad[task] >= 0)
            return fsai->bad[task];
    }
    return -1;
}

SBI_API void sbi_fsai_mirror(sbi_fsai *fsai)
{
    for (int e = 0; e < fsai->entry_count; e++) {
        const float *row = fsai->rows + 12 * (size_t)e;
        float *turned = fsai->turned + 12 * (size_t)fsai->back[e];
        for (int r = 0; r < 3; r++)
            sbi_f4_store(turned + 4 * r, sbi_f4_make(row[r], row[4 + r], row[8 + r]));
    }
}

/* ---- products ------------------------------------------------------------------------------------------ */

/* out_i = sum of blocks^T times in, over the blocks of the rows; sums of even and odd places do not wait for each
 * other. */
SBI_FORCE_INLINE void sbi_fsai_product(const int *start, const int *columns, const float *blocks, const float *in,
                                       float *out, int first, int last)
{
    for (int i = first; i < last; i++) {
        sbi_float4 even = sbi_f4_make(0, 0, 0), odd = even;
        int e = start[i], end = start[i + 1];
        for (; e + 2 <= end; e += 2) {
            const float *block = blocks + 12 * (size_t)e;
            even = sbi_f4_add(even, sbi_f4_rows(sbi_f4_load(in + 4 * (size_t)columns[e]), block));
            odd = sbi_f4_add(odd, sbi_f4_rows(sbi_f4_load(in + 4 * (size_t)columns[e + 1]), block + 12));
        }
        if (e < end)
            even = sbi_f4_add(even, sbi_f4_rows(sbi_f4_load(in + 4 * (size_t)columns[e]), blocks + 12 * (size_t)e));
        sbi_f4_store(out + 4 * (size_t)i, sbi_f4_add(even, odd));
    }
}

SBI_API void sbi_fsai_multiply(const sbi_fsai *fsai, const float *in, float *out, int first, int last)
{
    sbi_fsai_product(fsai->start, fsai->columns, fsai->rows, in, out, first, last);
}

SBI_API void sbi_fsai_multiply_transposed(const sbi_fsai *fsai, const float *in, float *out, int first, int last)
{
    sbi_fsai_product(fsai->end, fsai->members, fsai->turned, in, out, first, last);
}
