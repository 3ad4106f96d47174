/* precond_lower: the factors of SSOR and IC(0), their making and their sweeps. Floor 1.
 *
 * M = (I + L) D (I + L)^T. With pieces, IC(0) eliminates from both ends of the nodes' order towards its middle: two
 * halves that do not touch, for two threads, and last what is between them (twisted factorisation, van der Vorst
 * 1987). */
#include <float.h>
#include <limits.h>
#include <string.h>

#include "precond_private.h"

/* ---- the lower triangle -------------------------------------------------------------------------------- */

/* Whether node i, which is not one of the first half, touches one: columns ascend, and patterns are symmetric. */
static int sbi_precond_touches(const sb_matrix *a, int i, int first_half)
{
    return a->columns[a->row_start[i]] < first_half;
}

/* Nodes from `first_half` on that touch one before. */
static int sbi_precond_count_between(const sb_matrix *a, int first_half)
{
    int count = 0;
    for (int i = first_half; i < a->row_count; i++)
        count += sbi_precond_touches(a, i, first_half);
    return count;
}

/* Two halves of about as many nodes, if asked for and where that leaves few between them; else one. */
static void sbi_precond_make_order(sb_preconditioner *p, const sb_matrix *a, int halved)
{
    int rows = a->row_count, first_half = (rows - sbi_precond_count_between(a, rows / 2)) / 2, at = 0;
    int between = sbi_precond_count_between(a, first_half);
    if (!halved || rows < SBI_PRECOND_HALVED_ROWS || between > rows / SBI_PRECOND_BETWEEN)
        first_half = rows;
    for (int i = 0; i < first_half; i++)
        p->order[at++] = i;
    p->part[1] = at;
    for (int i = rows; i-- > first_half;)
        if (!sbi_precond_touches(a, i, first_half))
            p->order[at++] = i;
    p->part[2] = at;
    for (int i = first_half; i < rows; i++)
        if (sbi_precond_touches(a, i, first_half))
            p->order[at++] = i;
    p->part[3] = at;
}

static int sbi_precond_halves(const sb_preconditioner *p) { return p->part[2] > p->part[1] ? 2 : 1; }

/* Rows of L: of each node the blocks with those eliminated before it, in that order. place [row_count]: of the nodes in
 * the order. */
static void sbi_precond_fill_rows(sb_preconditioner *p, const sb_matrix *a, const int *place)
{
    int end = 0;
    for (int k = 0; k < p->row_count; k++) {
        int i = p->order[k], begin = end;
        p->start[k] = begin;
        for (int q = a->row_start[i]; q < a->row_end[i]; q++) {
            int j = a->columns[q], e = end;
            if (place[j] >= k)
                continue;
            for (; e > begin && place[p->columns[e - 1]] > place[j]; e--) {
                p->columns[e] = p->columns[e - 1];
                p->source[e] = p->source[e - 1];
            }
            p->columns[e] = j;
            p->source[e] = a->transpose[q];
            end++;
        }
    }
    p->start[p->row_count] = end;
}

/* Columns of L: of each node the blocks with those eliminated after it, the last first. */
static void sbi_precond_fill_columns(sb_preconditioner *p)
{
    int rows = p->row_count, sum = 0;
    memset(p->below_start, 0, ((size_t)rows + 1) * sizeof(int));
    for (int e = 0; e < p->start[rows]; e++)
        p->below_start[p->columns[e]]++;
    for (int i = 0; i <= rows; i++)
        p->below_start[i] = sum += p->below_start[i]; /* where each ends */
    for (int k = 0; k < rows; k++)
        for (int e = p->start[k]; e < p->start[k + 1]; e++) {
            int *to = p->below + 2 * (size_t)--p->below_start[p->columns[e]];
            to[0] = p->order[k];
            to[1] = e;
        }
}

/* Walks all pairs of the factorisation and counts them; writes the first `room`. in_row [row_count] is scratch of
 * -1. */
static size_t sbi_precond_list_pairs(const sb_preconditioner *p, const int *place, int *in_row, size_t room)
{
    size_t total = 0;
    for (int k = 0; k < p->row_count; k++) {
        for (int e = p->start[k]; e < p->start[k + 1]; e++) {
            int j = p->columns[e];
            if (room)
                p->pair_start[e] = total;
            /* columns are in order, so in_row[] holds the m before j of this row when (i, j) is met */
            for (int b = p->start[place[j]]; b < p->start[place[j] + 1]; b++) {
                if (in_row[p->columns[b]] < 0)
                    continue;
                if (total < room) {
                    p->pairs[2 * total] = in_row[p->columns[b]];
                    p->pairs[2 * total + 1] = b;
                }
                total++;
            }
            in_row[j] = e - p->start[k];
        }
        for (int e = p->start[k]; e < p->start[k + 1]; e++)
            in_row[p->columns[e]] = -1;
    }
    if (room)
        p->pair_start[p->lower_count] = total;
    return total;
}

/* Memory of the pairs: as many as there are, and of a matrix that follows as many again by half. */
static int sbi_precond_take_pairs(sb_preconditioner *p, size_t lower, size_t total)
{
    size_t longest = (size_t)(p->row_room ? p->longest_room : p->longest);
    p->pair_room = (p->row_room ? total + total / 2 : total) + 1;
    p->pair_start = (size_t *)sbi_owned_take(&p->owned, lower + 1, sizeof(size_t));
    p->pairs = (int *)sbi_owned_take(&p->owned, p->pair_room, 2 * sizeof(int));
    p->row = sbi_owned_take_floats(&p->owned, 2 * longest, 12);
    if (p->row_room) {
        p->place = sbi_owned_take_ints(&p->owned, (size_t)p->row_room);
        p->in_row = sbi_owned_take_ints(&p->owned, 2 * (size_t)p->row_room);
        p->found = sbi_owned_take_ints(&p->owned, 4 * longest);
        if (!p->place || !p->in_row || !p->found)
            return 0;
    }
    return p->pair_start && p->pairs && p->row;
}

/* Lists the pairs; may_take: their memory is still to be had. 0: there is none. */
static int sbi_precond_make_pairs(sb_preconditioner *p, const int *place, int *in_row, size_t lower, int may_take)
{
    p->longest = 0;
    for (int k = 0; k < p->row_count; k++) {
        in_row[k] = -1;
        p->longest = sbi_max_int(p->longest, p->start[k + 1] - p->start[k]);
    }
    if (may_take && !sbi_precond_take_pairs(p, lower, sbi_precond_list_pairs(p, place, in_row, 0)))
        return 0;
    p->unlisted = sbi_precond_list_pairs(p, place, in_row, p->pair_room) > p->pair_room;
    if (p->row_room) {
        memcpy(p->place, place, (size_t)p->row_count * sizeof(int));
        for (int k = 0; k < 2 * p->row_room; k++)
            p->in_row[k] = -1;
    }
    return 1;
}

/* Order, rows and pairs for a pattern; place: scratch [2 row_count]. */
static int sbi_precond_fill_lower(sb_preconditioner *p, const sb_matrix *a, int halved, int *place, size_t lower,
                                  int may_take)
{
    sbi_precond_make_order(p, a, halved);
    for (int k = 0; k < p->row_count; k++)
        place[p->order[k]] = k;
    sbi_precond_fill_rows(p, a, place);
    sbi_precond_fill_columns(p);
    return p->kind != SB_PRECOND_IC0 || sbi_precond_make_pairs(p, place, place + p->row_count, lower, may_take);
}

SBI_API int sbi_precond_make_lower(sb_preconditioner *p, const sb_matrix *a, int halved)
{
    size_t rows = (size_t)(p->row_room ? p->row_room : p->row_count);
    size_t lower = (size_t)(p->row_room ? p->block_room / 2 : p->lower_count);
    int *place = (int *)sbi_alloc(&p->owned.allocator, rows, 2 * sizeof(int)), made;
    p->order = sbi_owned_take_ints(&p->owned, rows);
    p->start = sbi_owned_take_ints(&p->owned, rows + 1);
    p->columns = sbi_owned_take_ints(&p->owned, lower);
    p->source = sbi_owned_take_ints(&p->owned, lower);
    p->below_start = sbi_owned_take_ints(&p->owned, rows + 1);
    p->below = sbi_owned_take_ints(&p->owned, 2 * lower);
    p->lower = sbi_owned_take_floats(&p->owned, lower, 12);
    made = place && p->order && p->start && p->columns && p->source && p->below_start && p->below && p->lower;
    if (made)
        made = sbi_precond_fill_lower(p, a, halved, place, lower, 1);
    sbi_free(&p->owned.allocator, place);
    return made;
}

SBI_API void sbi_precond_shape_lower(sb_preconditioner *p, const sb_matrix *a, int halved)
{
    sbi_precond_fill_lower(p, a, halved, p->scratch, 0, 0);
}

/* ---- factorisations ------------------------------------------------------------------------------------ */

/* Inverse of a symmetric 3x3 matrix (row-major with rows of 4) when its pivots exceed `least`[k]; else 0. */
static int sbi_precond_invert(const sbi_float4 *d, const float *least, float *inverse)
{
    double a00 = (double)SBI_F4(d[0], 0), a01 = (double)SBI_F4(d[0], 1), a02 = (double)SBI_F4(d[0], 2);
    double a11 = (double)SBI_F4(d[1], 1), a12 = (double)SBI_F4(d[1], 2), a22 = (double)SBI_F4(d[2], 2);
    double c00 = a11 * a22 - a12 * a12, c01 = a02 * a12 - a01 * a22, c02 = a01 * a12 - a02 * a11;
    double minor = a00 * a11 - a01 * a01, det = a00 * c00 + a01 * c01 + a02 * c02, f;
    /* pivots of the elimination: a00, minor / a00, det / minor; comparisons are false for NaN */
    if (!(a00 > (double)least[0] && minor > (double)least[1] * a00 && det > (double)least[2] * minor))
        return 0;
    f = 1 / det;
    sbi_f4_store(inverse, sbi_f4_make((float)(c00 * f), (float)(c01 * f), (float)(c02 * f)));
    sbi_f4_store(inverse + 4, sbi_f4_make((float)(c01 * f), (float)((a00 * a22 - a02 * a02) * f),
                                          (float)((a01 * a02 - a00 * a12) * f)));
    sbi_f4_store(inverse + 8, sbi_f4_make((float)(c02 * f), (float)((a01 * a02 - a00 * a12) * f), (float)(minor * f)));
    return 1;
}

/* Diagonal block i times `factor` in d; smallest pivots that still mean something in `least`. */
SBI_FORCE_INLINE void sbi_precond_diagonal(const sb_preconditioner *p, const sb_matrix *a, int i, double factor,
                                           sbi_float4 *d, float *least)
{
    const sb_real *block = a->blocks[a->diagonal[i]];
    for (int r = 0; r < 3; r++) {
        float diagonal = sbi_precond_in_range((double)block[4 * r] * p->matrix_scale * factor);
        d[r] = sbi_f4_round_row(block + 3 * r, (sb_real)p->matrix_scale);
        SBI_F4(d[r], r) = diagonal;
        least[r] = diagonal > 0 ? 64 * FLT_EPSILON * diagonal : 0;
    }
}

SBI_API int sbi_precond_invert_diagonals(sb_preconditioner *p, const sb_matrix *a)
{
    for (int i = 0; i < p->row_count; i++) {
        sbi_float4 d[3];
        float least[3];
        sbi_precond_diagonal(p, a, i, 1, d, least);
        if (!sbi_precond_invert(d, least, p->inverse + 12 * (size_t)i))
            return i;
    }
    return -1;
}

/* M = (D + w L_A) D^-1 (D + w L_A)^T up to a factor, hence L = w L_A D^-1. */
SBI_API void sbi_precond_fill_ssor(sb_preconditioner *p, const sb_matrix *a)
{
    const sb_real relaxation = (sb_real)1.3; /* flat optimum: 1.0 to 1.6 differ by a few iterations */
    sb_real scale = (sb_real)p->matrix_scale * relaxation;
    for (int e = 0; e < p->lower_count; e++) {
        const sb_real *upper = a->blocks[p->source[e]]; /* (j, i): its columns are the rows of (i, j) */
        const float *inverse = p->inverse + 12 * (size_t)p->columns[e];
        sbi_float4 u0 = sbi_f4_round_row(upper, scale), u1 = sbi_f4_round_row(upper + 3, scale);
        sbi_float4 u2 = sbi_f4_round_row(upper + 6, scale);
        float *out = p->lower + 12 * (size_t)e;
        for (int r = 0; r < 3; r++)
            sbi_f4_store(out + 4 * r, sbi_f4_rows(sbi_f4_make(SBI_F4(u0, r), SBI_F4(u1, r), SBI_F4(u2, r)), inverse));
    }
}

/* Block e = (i, j) of row i, whose transposed unscaled blocks are in `row` as U_im = L_im D_m:
 * U_ij = A_ij - sum_m U_im L_jm^T, L_ij = U_ij D_j^-1, D_i -= L_ij U_ij^T. */
SBI_FORCE_INLINE void sbi_precond_eliminate(sb_preconditioner *p, const sb_matrix *a, int e, const int *pairs,
                                            size_t pair_count, const float *row, float *out_row, sbi_float4 *d)
{
    const sb_real *upper = a->blocks[p->source[e]];
    sb_real scale = (sb_real)p->matrix_scale;
    sbi_float4 u0 = sbi_f4_round_row(upper, scale), u1 = sbi_f4_round_row(upper + 3, scale);
    sbi_float4 u2 = sbi_f4_round_row(upper + 6, scale);
    const float *inverse = p->inverse + 12 * (size_t)p->columns[e];
    float *l = p->lower + 12 * (size_t)e;
    int later = p->source[sbi_min_int(e + SBI_PRECOND_AHEAD, p->lower_count - 1)];
    SBI_PREFETCH(a->blocks[later], 0); /* blocks of a column lie in many places */
    SBI_PREFETCH(a->blocks[later], 64);
    for (size_t k = 0; k < pair_count; k++) {
        const float *ut = row + 12 * (size_t)pairs[2 * k], *b = p->lower + 12 * (size_t)pairs[2 * k + 1];
        u0 = sbi_f4_sub(u0, sbi_f4_rows(sbi_f4_load(b), ut));
        u1 = sbi_f4_sub(u1, sbi_f4_rows(sbi_f4_load(b + 4), ut));
        u2 = sbi_f4_sub(u2, sbi_f4_rows(sbi_f4_load(b + 8), ut));
    }
    sbi_f4_store(out_row, u0);
    sbi_f4_store(out_row + 4, u1);
    sbi_f4_store(out_row + 8, u2);
    for (int r = 0; r < 3; r++) {
        sbi_float4 x = sbi_f4_rows(sbi_f4_make(SBI_F4(u0, r), SBI_F4(u1, r), SBI_F4(u2, r)), inverse);
        sbi_f4_store(l + 4 * r, x);
        d[r] = sbi_f4_sub(d[r], sbi_f4_rows(x, out_row));
    }
}

/* Row k where there was no room to list the pairs: they are found again, in the same order. */
static void sbi_precond_eliminate_unlisted(sb_preconditioner *p, const sb_matrix *a, int k, int half, float *row,
                                           sbi_float4 *d)
{
    int *in_row = p->in_row + (size_t)half * (size_t)p->row_room;
    int *found = p->found + 2 * (size_t)half * (size_t)p->longest_room, begin = p->start[k];
    for (int e = begin; e < p->start[k + 1]; e++) {
        int at = p->place[p->columns[e]];
        size_t count = 0;
        for (int b = p->start[at]; b < p->start[at + 1]; b++) {
            if (in_row[p->columns[b]] < 0)
                continue;
            found[2 * count] = in_row[p->columns[b]];
            found[2 * count++ + 1] = b;
        }
        sbi_precond_eliminate(p, a, e, found, count, row, row + 12 * (size_t)(e - begin), d);
        in_row[p->columns[e]] = e - begin;
    }
    for (int e = begin; e < p->start[k + 1]; e++)
        in_row[p->columns[e]] = -1;
}

/* Rows of one part of the block IC(0) of A with its diagonal times 1 + shift: node of the first bad pivot, or -1. */
static int sbi_precond_factor_part(sb_preconditioner *p, const sb_matrix *a, int part, double shift)
{
    float *row = p->row + 12 * (size_t)(part == 1 ? p->longest : 0); /* the halves may be at work together */
    const size_t *at = p->pair_start;
    for (int k = p->part[part]; k < p->part[part + 1]; k++) {
        sbi_float4 d[3];
        float least[3];
        int i = p->order[k];
        sbi_precond_diagonal(p, a, i, 1 + shift, d, least);
        if (p->unlisted)
            sbi_precond_eliminate_unlisted(p, a, k, part == 1, row, d);
        for (int e = p->start[k]; e < p->start[k + 1] && !p->unlisted; e++)
            sbi_precond_eliminate(p, a, e, p->pairs + 2 * at[e], at[e + 1] - at[e], row,
                                  row + 12 * (size_t)(e - p->start[k]), d);
        if (!sbi_precond_invert(d, least, p->inverse + 12 * (size_t)i))
            return i;
    }
    return -1;
}

/* Shifts go 0, 0.001, 0.002 ..., and with pieces 1/16, 1/8, 1/4 ...: close to breakdown a factor has huge entries and
 * takes twice the iterations, and what a shift costs in smooth motions the pieces make up for. */
static double sbi_precond_least_shift(const sb_preconditioner *p) { return p->coarse.piece_count ? 1.0 / 16 : 0; }
static double sbi_precond_second_shift(const sb_preconditioner *p) { return p->coarse.piece_count ? 1.0 / 8 : 1e-3; }

static double sbi_precond_lower_shift(const sb_preconditioner *p)
{
    return p->shift > 1.5 * sbi_precond_second_shift(p) ? p->shift / 2 : sbi_precond_least_shift(p);
}

static double sbi_precond_raise_shift(const sb_preconditioner *p, double shift)
{
    double second = sbi_precond_second_shift(p);
    return shift < second ? second : 2 * shift;
}

SBI_API int sbi_precond_begin_ic0(sb_preconditioner *p)
{
    double least = sbi_precond_least_shift(p);
    p->relaxing = p->shift > least && p->successes >= p->wait;
    p->trial = p->relaxing ? sbi_precond_lower_shift(p) : p->shift < least ? least : p->shift;
    p->bad[0] = p->bad[1] = -1;
    return sbi_precond_halves(p);
}

SBI_API void sbi_precond_factor_half(sb_preconditioner *p, const sb_matrix *a, int half)
{
    p->bad[half] = sbi_precond_factor_part(p, a, half, p->trial);
}

/* What is between the halves: node of the first bad pivot of all, or -1. */
static int sbi_precond_factor_between(sb_preconditioner *p, const sb_matrix *a)
{
    int bad = p->bad[0] >= 0 ? p->bad[0] : p->bad[1];
    return bad >= 0 ? bad : sbi_precond_factor_part(p, a, 2, p->trial);
}

/* Shifts rise until there is a factor. Seldom more than once in a body's life, hence on one thread. */
SBI_API sb_result sbi_precond_end_ic0(sb_preconditioner *p, const sb_matrix *a, sb_error *error)
{
    int bad = sbi_precond_factor_between(p, a);
    for (p->attempts = 1; bad >= 0 && p->attempts < SBI_PRECOND_MAX_ATTEMPTS; p->attempts++) {
        if (p->trial >= (double)SBI_PRECOND_MAX_SHIFT)
            break;
        p->trial = sbi_precond_raise_shift(p, p->trial);
        for (int half = 0; half < 2; half++)
            sbi_precond_factor_half(p, a, half);
        bad = sbi_precond_factor_between(p, a);
    }
    if (bad >= 0) {
        p->shift = 0; /* the next matrix may be a tamer one */
        return sbi_fail_node(error, SB_ERROR_INDEFINITE, bad, "node %d: no incomplete factor up to a shift of %g", bad,
                             p->trial);
    }
    if (p->attempts > 1) {
        p->wait = p->relaxing && p->wait < SBI_PRECOND_RELAX_LAST ? 2 * p->wait : p->wait;
        p->successes = 0;
    } else {
        p->successes = p->relaxing ? 0 : p->successes + (p->successes < INT_MAX);
    }
    p->shift = p->trial;
    return SB_OK;
}

/* ---- sweeps --------------------------------------------------------------------------------------------- */

/* middle = (I + L)^-1 r, result = D^-1 middle, of one part. Here and below the arrays are named first: a store of a
 * vector may change anything, also p, as far as a compiler knows. */
static void sbi_precond_forward(const sbi_precond_job *job, int part)
{
    sb_preconditioner *p = job->p;
    const sb_real *r = job->r;
    const int *start = p->start, *columns = p->columns, *order = p->order;
    const float *l = p->lower + 12 * (size_t)start[p->part[part]], *inverse = p->inverse;
    float *middle = p->middle, *result = p->result;
    sb_real scale = (sb_real)job->scale;
    int plain = !p->turned, last = p->row_count - 1;
    for (int k = p->part[part], end = p->part[part + 1]; k < end; k++) {
        sbi_float4 s0 = sbi_f4_make(0, 0, 0), s1 = s0, s2 = s0, y;
        size_t i = (size_t)order[k];
        for (int e = start[k], row_end = start[k + 1]; e < row_end; e++, l += 12) {
            sbi_float4 v = sbi_f4_load(middle + 4 * (size_t)columns[e]);
            s0 = sbi_f4_add(s0, sbi_f4_mul(sbi_f4_load(l), v));
            s1 = sbi_f4_add(s1, sbi_f4_mul(sbi_f4_load(l + 4), v));
            s2 = sbi_f4_add(s2, sbi_f4_mul(sbi_f4_load(l + 8), v));
        }
        y = plain && order[k] != last ? sbi_f4_round_row(r + 3 * i, scale) : sbi_precond_enter(p, r, i, scale);
        y = sbi_f4_sub(y, sbi_f4_sums(s0, s1, s2));
        sbi_f4_store(middle + 4 * i, y);
        sbi_f4_store(result + 4 * i, sbi_f4_rows(y, inverse + 12 * i));
    }
}

/* result = (I + L)^-T result, of one part; those after it are done. Each row is gathered, the nearest of its nodes
 * last: only that one is waited for. Rows that take themselves from those before them wait for every store. */
static void sbi_precond_backward(const sbi_precond_job *job, int part)
{
    const sb_preconditioner *p = job->p;
    const int *start = p->below_start, *order = p->order, *below = p->below;
    const float *lower = p->lower;
    float *result = p->result;
    for (int k = p->part[part + 1], first = p->part[part]; k-- > first;) {
        size_t i = (size_t)order[k];
        sbi_float4 z = sbi_f4_load(result + 4 * i);
        for (int b = start[i], end = start[i + 1]; b < end; b++) {
            const int *from = below + 2 * (size_t)b;
            z = sbi_f4_sub(z, sbi_f4_rows(sbi_f4_load(result + 4 * (size_t)from[0]), lower + 12 * (size_t)from[1]));
        }
        sbi_f4_store(result + 4 * i, z);
    }
}

static void sbi_precond_forward_task(void *user, int half) { sbi_precond_forward((const sbi_precond_job *)user, half); }
static void sbi_precond_backward_task(void *user, int half)
{
    sbi_precond_backward((const sbi_precond_job *)user, half);
}

SBI_API void sbi_precond_sweep(const sbi_precond_job *job)
{
    sbi_precond_job mine = *job;
    int halves = sbi_precond_halves(job->p);
    sbi_run(&job->p->jobs, sbi_precond_forward_task, &mine, halves);
    sbi_precond_forward(job, 2);
    sbi_precond_backward(job, 2);
    sbi_run(&job->p->jobs, sbi_precond_backward_task, &mine, halves);
}
