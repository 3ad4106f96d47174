/* cpd_sums: the expectation step, P_mn = exp(-|x_n - T y_m|^2 / 2 s2) / (sum_k exp(-|x_n - T y_k|^2 / 2 s2) + c).
 *
 * Both clouds lie in blocks of neighbours. For a block of the target, blocks of the source are left out whose share of
 * every P is small for certain, by the distances of boxes; all others are summed in loops over whole blocks. That is
 * faster than a search tree with its single points, needs none for the source, which moves, and the bound holds without
 * a guess of the width: a term left out is below tolerance / M of the largest term, or of c. */
#include "cpd_private.h"

#include <string.h>

/* e^x for x <= 0 to 1e-11 of it (below -700: e^-700), of operations that vectorise: 2^n 2^f with n in the low bits of
 * a sum with 1.5 2^52. */
SBI_FORCE_INLINE double regi_cpd_exp(double x)
{
    double t = (x > -700.0 ? x : -700.0) * 1.4426950408889634, n = t + 6755399441055744.0;
    double f = t - (n - 6755399441055744.0), p;
    p = 1.3215486790144307e-6 + f * 1.0178086009239699e-7;
    p = 1.5403530393381608e-4 + f * (1.5252733804059841e-5 + f * p);
    p = 9.618129107628477e-3 + f * (1.3333558146428443e-3 + f * p);
    p = 2.402265069591007e-1 + f * (5.550410866482158e-2 + f * p);
    p = 1.0 + f * (6.931471805599453e-1 + f * p);
    return sbi_dense_from_bits(sbi_dense_bits(p) + (sbi_dense_bits(n) << 52));
}

REGI_API void regi_cpd_bound(const regi_cpd_block *points, int blocks, regi_cpd_box *boxes)
{
    for (int b = 0; b < blocks; b++)
        for (int axis = 0; axis < 3; axis++) {
            const double *x = axis == 0 ? points[b].x : axis == 1 ? points[b].y : points[b].z;
            double low = x[0], high = x[0];
            for (int l = 1; l < REGI_CPD_LANES; l++) {
                low = x[l] < low ? x[l] : low;
                high = x[l] > high ? x[l] : high;
            }
            boxes[b].low[axis] = low;
            boxes[b].high[axis] = high;
        }
}

/* Squares of the smallest and the largest distance between points of two boxes. */
static void regi_cpd_box_distances(const regi_cpd_box *a, const regi_cpd_box *b, double *least, double *most)
{
    double near_sum = 0, far_sum = 0;
    for (int axis = 0; axis < 3; axis++) {
        double up = b->high[axis] - a->low[axis], down = a->high[axis] - b->low[axis];
        double gap = -up > -down ? -up : -down, reach = up > down ? up : down;
        near_sum += gap > 0 ? gap * gap : 0.0;
        far_sum += reach * reach;
    }
    *least = near_sum;
    *most = far_sum;
}

/* Blocks of the source that count for a block of the target; returns how many. */
static int regi_cpd_find_near(const regi_cpd_expectation *e, const regi_cpd_box *box, int *blocks)
{
    double width = 2 * e->sigma2, limit = 1.7976931348623157e308, least, most;
    double share = e->tolerance > 0 ? sbi_dense_log((double)e->source->count / e->tolerance) : 0.0;
    int count = 0;
    if (e->tolerance > 0) {
        for (int b = 0; b < e->source->blocks; b++) {
            regi_cpd_box_distances(box, e->source->boxes + b, &least, &most);
            limit = most < limit ? most : limit;
        }
        limit += width * share;
        if (e->outlier > 0 && e->outlier < 1) { /* a point that is near has most of its probability */
            double alone = width * (share - sbi_dense_log(e->outlier));
            limit = alone < limit ? alone : limit;
        }
    }
    for (int b = 0; b < e->source->blocks; b++) {
        regi_cpd_box_distances(box, e->source->boxes + b, &least, &most);
        if (least <= limit)
            blocks[count++] = b;
    }
    return count;
}

/* terms = squared distances; returns the smallest. */
static double regi_cpd_distances(const regi_cpd_block *moved, const int *blocks, int count, const double at[3],
                                 double (*SB_RESTRICT terms)[REGI_CPD_LANES])
{
    double low[REGI_CPD_LANES], least;
    for (int l = 0; l < REGI_CPD_LANES; l++)
        low[l] = 1.7976931348623157e308;
    for (int i = 0; i < count; i++) {
        const regi_cpd_block *block = moved + blocks[i];
        double *SB_RESTRICT out = terms[i];
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            double x = at[0] - block->x[l], y = at[1] - block->y[l], z = at[2] - block->z[l], d = x * x + y * y + z * z;
            out[l] = d;
            low[l] = d < low[l] ? d : low[l];
        }
    }
    least = low[0];
    for (int l = 1; l < REGI_CPD_LANES; l++)
        least = low[l] < least ? low[l] : least;
    return least;
}

/* terms = exp((least - terms) / 2 s2), 0 for what fills up the last block; returns their sum. */
static double regi_cpd_exponentials(const regi_cpd_expectation *e, double least, const int *blocks, int count,
                                    double (*SB_RESTRICT terms)[REGI_CPD_LANES])
{
    double sums[REGI_CPD_LANES], sum = 0, scale = 1 / (2 * e->sigma2);
    int used = e->source->count - (e->source->blocks - 1) * REGI_CPD_LANES;
    for (int l = 0; l < REGI_CPD_LANES; l++)
        sums[l] = 0;
    for (int i = 0; i < count; i++) {
        double *SB_RESTRICT out = terms[i];
        for (int l = 0; l < REGI_CPD_LANES; l++)
            out[l] = regi_cpd_exp((least - out[l]) * scale);
        if (blocks[i] == e->source->blocks - 1)
            for (int l = used; l < REGI_CPD_LANES; l++)
                out[l] = 0;
        for (int l = 0; l < REGI_CPD_LANES; l++)
            sums[l] += out[l];
    }
    for (int l = 0; l < REGI_CPD_LANES; l++)
        sum += sums[l];
    return sum;
}

/* Adds P of one target point, factor terms, to the sums; returns sum P |x - T|^2. */
static double regi_cpd_gather(const regi_cpd_block *moved, const int *blocks, int count, const double at[3],
                              double factor, double (*SB_RESTRICT terms)[REGI_CPD_LANES],
                              regi_cpd_sums *SB_RESTRICT sums)
{
    double squares[REGI_CPD_LANES], sum = 0;
    for (int l = 0; l < REGI_CPD_LANES; l++)
        squares[l] = 0;
    for (int i = 0; i < count; i++) {
        const regi_cpd_block *block = moved + blocks[i];
        regi_cpd_sums *SB_RESTRICT out = sums + blocks[i];
        const double *SB_RESTRICT term = terms[i];
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            double p = factor * term[l], x = at[0] - block->x[l], y = at[1] - block->y[l], z = at[2] - block->z[l];
            out->p[l] += p;
            out->x[l] += p * x;
            out->y[l] += p * y;
            out->z[l] += p * z;
            squares[l] += p * (x * x + y * y + z * z);
        }
    }
    for (int l = 0; l < REGI_CPD_LANES; l++)
        sum += squares[l];
    return sum;
}

static void regi_cpd_compare(const int *blocks, int count, int target, double factor,
                             double (*SB_RESTRICT terms)[REGI_CPD_LANES], regi_cpd_best *best)
{
    for (int i = 0; i < count; i++) {
        regi_cpd_best *b = best + blocks[i];
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            double p = factor * terms[i][l];
            if (p > b->probability[l] || (p > 0 && p == b->probability[l] && target < b->target[l])) {
                b->probability[l] = p;
                b->target[l] = target;
            }
        }
    }
}

/* One target point. The largest term is made 1, so that a point far from all still has partners when c is 0. */
static void regi_cpd_take(regi_cpd_expectation *e, int chunk, int index, int count)
{
    const regi_cpd_block *block = e->target->points + index / REGI_CPD_LANES;
    int lane = index % REGI_CPD_LANES;
    size_t first = (size_t)chunk * (size_t)e->source->blocks;
    const int *blocks = e->near_blocks + first;
    double(*terms)[REGI_CPD_LANES] = e->terms + first;
    double at[3], least, sum, depth, factor;
    regi_cpd_totals *totals = e->totals + chunk;
    at[0] = block->x[lane], at[1] = block->y[lane], at[2] = block->z[lane];
    least = regi_cpd_distances(e->moved, blocks, count, at, terms);
    if (e->outlier > 0 &&
        (count == 0 || least > 700 * 2 * e->sigma2)) { /* below anything that differs from 0 beside c */
        totals->logs -= sbi_dense_log(e->outlier);
        return;
    }
    depth = least / (2 * e->sigma2);
    sum = regi_cpd_exponentials(e, least, blocks, count, terms);
    if (e->outlier > 0) {
        double size = sbi_dense_exp(-depth), whole = size * sum + e->outlier;
        factor = size / whole;
        totals->logs -= sbi_dense_log(whole);
    } else {
        factor = 1 / sum;
        totals->logs += depth - sbi_dense_log(sum);
    }
    totals->explained += factor * sum;
    totals->pairs += (double)(count * REGI_CPD_LANES);
    totals->squares += regi_cpd_gather(e->moved, blocks, count, at, factor, terms, e->sums + first);
    if (e->best)
        regi_cpd_compare(blocks, count, e->target->order[index], factor, terms, e->best);
}

static void regi_cpd_expect_chunk(void *user, int chunk)
{
    regi_cpd_expectation *e = (regi_cpd_expectation *)user;
    size_t first = (size_t)chunk * (size_t)e->source->blocks;
    int chunks = e->best ? 1 : REGI_CPD_CHUNKS; /* partners are kept once */
    int begin = (int)((int64_t)e->target->blocks * chunk / chunks);
    int end = (int)((int64_t)e->target->blocks * (chunk + 1) / chunks);
    memset(e->sums + first, 0, (size_t)e->source->blocks * sizeof(regi_cpd_sums));
    memset(e->totals + chunk, 0, sizeof(regi_cpd_totals));
    if (chunk >= chunks)
        return;
    for (int b = begin; b < end; b++) {
        int count = regi_cpd_find_near(e, e->target->boxes + b, e->near_blocks + first);
        int last = sbi_min_int((b + 1) * REGI_CPD_LANES, e->target->count);
        for (int i = b * REGI_CPD_LANES; i < last; i++)
            regi_cpd_take(e, chunk, i, count);
    }
}

REGI_API void regi_cpd_expect(regi_cpd_expectation *e, const sb_jobs *jobs)
{
    int blocks = e->source->blocks;
    for (int b = 0; e->best && b < blocks; b++)
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            e->best[b].probability[l] = 0;
            e->best[b].target[l] = -1;
        }
    sbi_run(jobs, regi_cpd_expect_chunk, e, REGI_CPD_CHUNKS);
    for (int chunk = 1; chunk < REGI_CPD_CHUNKS; chunk++) {
        const regi_cpd_sums *from = e->sums + (size_t)chunk * (size_t)blocks;
        e->totals[0].explained += e->totals[chunk].explained;
        e->totals[0].squares += e->totals[chunk].squares;
        e->totals[0].logs += e->totals[chunk].logs;
        e->totals[0].pairs += e->totals[chunk].pairs;
        for (int b = 0; b < blocks; b++)
            for (int l = 0; l < REGI_CPD_LANES; l++) {
                e->sums[b].p[l] += from[b].p[l];
                e->sums[b].x[l] += from[b].x[l];
                e->sums[b].y[l] += from[b].y[l];
                e->sums[b].z[l] += from[b].z[l];
            }
    }
}
