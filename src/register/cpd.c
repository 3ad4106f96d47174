/* cpd: coherent point drift; the formulas are those of Myronenko and Song 2010, figures 2 to 4. */
#include "cpd.h"

#include <string.h>

#include "../softbody/geometry/embed_search.h"
#include "cpd_private.h"

enum { REGI_CPD_COOKIE = 0x63706431 };

static const double regi_cpd_least_sigma2 = 1e-10; /* in the frame of the target */

/* z = (x / unit - mean) / size: mean 0, rms 1. */
typedef struct regi_cpd_frame {
    double unit, mean[3], size;
} regi_cpd_frame;

/* y -> linear y + shift, in the frames of the clouds. */
typedef struct regi_cpd_affine {
    double linear[3][3], shift[3];
} regi_cpd_affine;

struct reg_cpd {
    sb_allocator allocator;
    reg_cpd_info info;
    int count;
    regi_cpd_frame source, target;
    regi_cpd_affine map;    /* the identity when non-rigid */
    double inverse;         /* 1 / (2 beta^2) */
    double (*centres)[3];   /* [rank] pivots in the source's frame */
    double (*weights)[3];   /* [rank] */
    sb_vec3 *moved;         /* [count] */
    int *partners;          /* [count] */
    sb_real *probabilities; /* [count] */
    void *memory;
};

/* A fit being made. */
typedef struct regi_cpd_run {
    reg_cpd_options options;
    regi_cpd_frame source_frame, target_frame;
    regi_cpd_cloud source, target;
    regi_cpd_block *moved, *next; /* [source blocks] the source after this iteration and after the next */
    double (*landmarks)[3];       /* [landmark_count] their places in the target's frame */
    int *landmark_slots;          /* [landmark_count] in the order of the source */
    double landmark_weight;       /* 1 / sigma^2 of the landmarks, in the target's frame */
    double *p, *r[3];             /* [rows] P and P X - P Y, with landmarks */
    regi_cpd_affine map;
    double sigma2, energy; /* energy: |L^T W|^2 */
    regi_cpd_kernel kernel;
    regi_cpd_expectation e;
    reg_cpd_info info;
    double start;           /* s */
    sb_vec3 *sort_points;   /* [larger count] */
    uint32_t *sort_scratch; /* [3 larger count] */
    int *slot_of;           /* [source count] */
    void *memory;
} regi_cpd_run;

/* ---- options and input ---- */

REG_API reg_cpd_options reg_default_cpd_options(void)
{
    reg_cpd_options options;
    memset(&options, 0, sizeof options);
    options.kind = REG_CPD_NONRIGID;
    options.outliers = (sb_real)0.1;
    options.beta = 2;
    options.lambda = 3;
    options.kernel_tolerance = (sb_real)1e-4;
    options.max_rank = 1000;
    options.sum_tolerance = (sb_real)1e-5;
    options.tolerance = (sb_real)1e-6;
    options.max_iterations = 300;
    options.max_pairs = 4e8;
    options.cookie = REGI_CPD_COOKIE;
    return options;
}

static sb_result regi_cpd_check_options(const reg_cpd_options *o, sb_error *error)
{
    if (o->cookie != REGI_CPD_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the options were not made by reg_default_cpd_options");
    if ((int)o->kind < REG_CPD_RIGID || (int)o->kind > REG_CPD_NONRIGID)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "kind %d is none of reg_cpd_kind", (int)o->kind);
    if (!(o->outliers >= 0) || !(o->outliers < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the share of outliers is %g, not in [0, 1)", (double)o->outliers);
    if (!(o->beta >= (sb_real)1e-6) || !(o->beta <= (sb_real)1e6))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "beta is %g, not in [1e-6, 1e6]", (double)o->beta);
    if (!(o->lambda >= (sb_real)1e-12) || !(o->lambda <= (sb_real)1e12))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "lambda is %g, not in [1e-12, 1e12]", (double)o->lambda);
    if (!(o->start_sigma >= 0) || !sb_is_finite(o->start_sigma))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "start_sigma is %g", (double)o->start_sigma);
    if (!(o->kernel_tolerance > (sb_real)1e-12) || !(o->kernel_tolerance < 1) || o->max_rank < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "kernel_tolerance %g is not in (1e-12, 1), or max_rank %d below 1",
                        (double)o->kernel_tolerance, o->max_rank);
    if (!(o->sum_tolerance >= 0) || !(o->sum_tolerance <= (sb_real)0.1) || !(o->tolerance >= 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sum_tolerance is %g, not in [0, 0.1], or tolerance %g below 0",
                        (double)o->sum_tolerance, (double)o->tolerance);
    if (o->max_iterations < 0 || !(o->max_seconds >= 0) || !(o->max_pairs >= 0) || (o->max_seconds > 0 && !o->clock))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a cap is below 0, or one of time has no clock");
    return SB_OK;
}

static sb_result regi_cpd_check_cloud(const sb_vec3 *points, int count, const char *name, sb_error *error)
{
    if (!points || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the %s has no points", name);
    for (int i = 0; i < count; i++)
        if (!sb_v3_is_finite(points[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "point %d of the %s is not finite", i, name);
    return SB_OK;
}

static sb_result regi_cpd_check_landmarks(const reg_cpd_options *o, int source_count, sb_error *error)
{
    if (o->landmark_count == 0)
        return SB_OK;
    if (o->landmark_count < 0 || !o->landmark_points || !o->landmark_targets)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d landmarks, or no arrays of them", o->landmark_count);
    if (!(o->landmark_sigma > 0) || !sb_is_finite(o->landmark_sigma))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "landmark_sigma is %g m", (double)o->landmark_sigma);
    for (int i = 0; i < o->landmark_count; i++)
        if (o->landmark_points[i] < 0 || o->landmark_points[i] >= source_count)
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "landmark %d is at point %d of %d", i,
                                 o->landmark_points[i], source_count);
    return regi_cpd_check_cloud(o->landmark_targets, o->landmark_count, "landmarks", error);
}

static sb_result regi_cpd_check(const sb_vec3 *source, int source_count, const sb_vec3 *target, int target_count,
                                const reg_cpd_options *options, sb_error *error)
{
    sb_result result = regi_cpd_check_options(options, error);
    if (result == SB_OK)
        result = regi_cpd_check_cloud(source, source_count, "source", error);
    if (result == SB_OK)
        result = regi_cpd_check_cloud(target, target_count, "target", error);
    if (result == SB_OK)
        result = regi_cpd_check_landmarks(options, source_count, error);
    if (result == SB_OK && (double)source_count * (double)target_count > options->max_pairs)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "%d times %d points are more than max_pairs %g: thin the clouds",
                        source_count, target_count, options->max_pairs);
    return result;
}

/* ---- frames ---- */

static double regi_cpd_largest(double a, double b) { return a > b ? a : b; }

static void regi_cpd_into(const regi_cpd_frame *frame, sb_vec3 point, double z[3])
{
    z[0] = ((double)point.x / frame->unit - frame->mean[0]) / frame->size;
    z[1] = ((double)point.y / frame->unit - frame->mean[1]) / frame->size;
    z[2] = ((double)point.z / frame->unit - frame->mean[2]) / frame->size;
}

static sb_vec3 regi_cpd_out_of(const regi_cpd_frame *frame, const double z[3])
{
    return sb_v3((sb_real)((z[0] * frame->size + frame->mean[0]) * frame->unit),
                 (sb_real)((z[1] * frame->size + frame->mean[1]) * frame->unit),
                 (sb_real)((z[2] * frame->size + frame->mean[2]) * frame->unit));
}

/* Mean in units of frame->unit. */
static void regi_cpd_centre(const sb_vec3 *points, int count, regi_cpd_frame *frame)
{
    for (int k = 0; k < 3; k++)
        frame->mean[k] = 0;
    for (int i = 0; i < count; i++) {
        frame->mean[0] += ((double)points[i].x / frame->unit - frame->mean[0]) / (i + 1);
        frame->mean[1] += ((double)points[i].y / frame->unit - frame->mean[1]) / (i + 1);
        frame->mean[2] += ((double)points[i].z / frame->unit - frame->mean[2]) / (i + 1);
    }
}

/* Size 0 for points in one place. */
static regi_cpd_frame regi_cpd_measure(const sb_vec3 *points, int count)
{
    regi_cpd_frame frame;
    double sum = 0, z[3];
    memset(&frame, 0, sizeof frame);
    for (int i = 0; i < count; i++) {
        frame.unit = regi_cpd_largest(frame.unit, fabs((double)points[i].x));
        frame.unit = regi_cpd_largest(frame.unit, fabs((double)points[i].y));
        frame.unit = regi_cpd_largest(frame.unit, fabs((double)points[i].z));
    }
    if (!(frame.unit > 0))
        frame.unit = 1;
    frame.size = 1;
    regi_cpd_centre(points, count, &frame);
    for (int i = 0; i < count; i++) {
        regi_cpd_into(&frame, points[i], z);
        sum += z[0] * z[0] + z[1] * z[1] + z[2] * z[2];
    }
    frame.size = sqrt(sum / count);
    if (!(frame.size > 1e-14)) /* the rounding of the mean */
        frame.size = 0;
    return frame;
}

/* The frames of both clouds. A cloud in one place has no size of its own and takes the other's. */
static void regi_cpd_set_frames(regi_cpd_run *run, const sb_vec3 *source, int source_count, const sb_vec3 *target,
                                int target_count)
{
    regi_cpd_frame y = regi_cpd_measure(source, source_count), x = regi_cpd_measure(target, target_count);
    if (!(y.size > 0)) {
        y.unit = x.size > 0 ? x.unit : y.unit;
        y.size = x.size > 0 ? x.size : 1.0;
        regi_cpd_centre(source, source_count, &y);
    }
    if (run->options.shared_frame) {
        x = y;
    } else if (run->options.kind == REG_CPD_RIGID || !(x.size > 0)) {
        x.unit = y.unit;
        x.size = y.size;
        regi_cpd_centre(target, target_count, &x);
    }
    run->source_frame = y;
    run->target_frame = x;
}

/* ---- memory ---- */

/* Hands out, or measures, all arrays whose size is known beforehand. */
static void regi_cpd_layout(regi_cpd_run *run, sbi_arena *arena)
{
    size_t m = (size_t)run->source.count, n = (size_t)run->target.count, blocks = (size_t)run->source.blocks;
    size_t more = m > n ? m : n, landmarks = (size_t)run->options.landmark_count, rows = blocks * REGI_CPD_LANES;
    run->source.order = (int *)sbi_arena_take(arena, m, sizeof(int));
    run->source.points = (regi_cpd_block *)sbi_arena_take(arena, blocks, sizeof(regi_cpd_block));
    run->source.boxes = (regi_cpd_box *)sbi_arena_take(arena, blocks, sizeof(regi_cpd_box));
    run->target.order = (int *)sbi_arena_take(arena, n, sizeof(int));
    run->target.points = (regi_cpd_block *)sbi_arena_take(arena, (size_t)run->target.blocks, sizeof(regi_cpd_block));
    run->target.boxes = (regi_cpd_box *)sbi_arena_take(arena, (size_t)run->target.blocks, sizeof(regi_cpd_box));
    run->moved = (regi_cpd_block *)sbi_arena_take(arena, blocks, sizeof(regi_cpd_block));
    run->next = (regi_cpd_block *)sbi_arena_take(arena, blocks, sizeof(regi_cpd_block));
    run->landmarks = (double(*)[3])sbi_arena_take(arena, landmarks, 3 * sizeof(double));
    run->landmark_slots = (int *)sbi_arena_take(arena, landmarks, sizeof(int));
    run->p = (double *)sbi_arena_take(arena, rows, sizeof(double));
    for (int k = 0; k < 3; k++)
        run->r[k] = (double *)sbi_arena_take(arena, rows, sizeof(double));
    run->e.sums = (regi_cpd_sums *)sbi_arena_take(arena, blocks, REGI_CPD_CHUNKS * sizeof(regi_cpd_sums));
    run->e.terms = (double(*)[REGI_CPD_LANES])sbi_arena_take(arena, rows, REGI_CPD_CHUNKS * sizeof(double));
    run->e.near_blocks = (int *)sbi_arena_take(arena, blocks, REGI_CPD_CHUNKS * sizeof(int));
    run->e.best = (regi_cpd_best *)sbi_arena_take(arena, blocks, sizeof(regi_cpd_best));
    run->sort_points = (sb_vec3 *)sbi_arena_take(arena, more, sizeof(sb_vec3));
    run->sort_scratch = (uint32_t *)sbi_arena_take(arena, more, 3 * sizeof(uint32_t));
    run->slot_of = (int *)sbi_arena_take(arena, m, sizeof(int));
}

static sb_result regi_cpd_allocate(regi_cpd_run *run, sb_error *error)
{
    sbi_arena arena;
    memset(&arena, 0, sizeof arena);
    regi_cpd_layout(run, &arena);
    run->memory = arena.overflow ? NULL : sbi_alloc(&run->options.allocator, arena.used, 1);
    if (!run->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for clouds of %d and %d points", run->source.count,
                        run->target.count);
    arena.base = (unsigned char *)run->memory;
    arena.used = 0;
    regi_cpd_layout(run, &arena);
    return SB_OK;
}

/* ---- start ---- */

/* Sorts the points and puts them into blocks, in their frame. */
static sb_result regi_cpd_fill(regi_cpd_run *run, regi_cpd_cloud *cloud, const sb_vec3 *points,
                               const regi_cpd_frame *frame, sb_error *error)
{
    double z[3], most = 0;
    for (int i = 0; i < cloud->count; i++) {
        regi_cpd_into(frame, points[i], z);
        run->sort_points[i] = sb_v3((sb_real)z[0], (sb_real)z[1], (sb_real)z[2]);
        for (int k = 0; k < 3; k++)
            most = z[k] - z[k] == 0.0 ? regi_cpd_largest(most, fabs(z[k])) : 1.7976931348623157e308;
        if (!(most < 1e15)) /* source and target far apart: squares must keep the digits of the smaller */
            return sbi_fail(error, SB_ERROR_ARGUMENT, "the clouds are too far apart or too unlike in size");
    }
    sbi_embed_sort(run->sort_points, cloud->count, cloud->order, run->sort_scratch);
    for (int i = 0; i < cloud->blocks * REGI_CPD_LANES; i++) {
        regi_cpd_block *block = cloud->points + i / REGI_CPD_LANES;
        regi_cpd_into(frame, points[cloud->order[sbi_min_int(i, cloud->count - 1)]], z);
        block->x[i % REGI_CPD_LANES] = z[0];
        block->y[i % REGI_CPD_LANES] = z[1];
        block->z[i % REGI_CPD_LANES] = z[2];
    }
    regi_cpd_bound(cloud->points, cloud->blocks, cloud->boxes);
    return SB_OK;
}

static sb_result regi_cpd_fill_landmarks(regi_cpd_run *run, sb_error *error)
{
    const reg_cpd_options *o = &run->options;
    double sigma = (double)o->landmark_sigma / run->target_frame.unit / run->target_frame.size;
    for (int i = 0; i < run->source.count; i++)
        run->slot_of[run->source.order[i]] = i;
    for (int i = 0; i < o->landmark_count; i++) {
        double *z = run->landmarks[i];
        run->landmark_slots[i] = run->slot_of[o->landmark_points[i]];
        regi_cpd_into(&run->target_frame, o->landmark_targets[i], z);
        if (!(fabs(z[0]) < 1e15) || !(fabs(z[1]) < 1e15) || !(fabs(z[2]) < 1e15))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "landmark %d is too far from the target", i);
    }
    if (o->landmark_count > 0) {
        if (!(sigma > 1e-9)) /* a weight that the system can take */
            return sbi_fail(error, SB_ERROR_ARGUMENT, "landmark_sigma %g m is below 1e-9 of the target's size",
                            (double)o->landmark_sigma);
        run->landmark_weight = 1 / (sigma * sigma);
    }
    return SB_OK;
}

/* Mean squared distance, per axis, of all pairs of points. */
static double regi_cpd_spread(const regi_cpd_cloud *a, const regi_cpd_cloud *b)
{
    const regi_cpd_cloud *cloud[2];
    double mean[2][3], squares = 0, gap = 0;
    cloud[0] = a, cloud[1] = b;
    for (int c = 0; c < 2; c++) {
        double sum = 0;
        mean[c][0] = mean[c][1] = mean[c][2] = 0;
        for (int i = 0; i < cloud[c]->count; i++) {
            const regi_cpd_block *p = cloud[c]->points + i / REGI_CPD_LANES;
            int l = i % REGI_CPD_LANES;
            mean[c][0] += p->x[l] / cloud[c]->count;
            mean[c][1] += p->y[l] / cloud[c]->count;
            mean[c][2] += p->z[l] / cloud[c]->count;
            sum += p->x[l] * p->x[l] + p->y[l] * p->y[l] + p->z[l] * p->z[l];
        }
        squares += sum / cloud[c]->count;
    }
    for (int k = 0; k < 3; k++)
        gap += mean[0][k] * mean[1][k];
    return (squares - 2 * gap) / 3;
}

static sb_result regi_cpd_prepare(regi_cpd_run *run, const sb_vec3 *source, const sb_vec3 *target, sb_error *error)
{
    const reg_cpd_options *o = &run->options;
    double sigma = (double)o->start_sigma / run->target_frame.unit / run->target_frame.size;
    sb_result result = regi_cpd_allocate(run, error);
    if (result == SB_OK)
        result = regi_cpd_fill(run, &run->source, source, &run->source_frame, error);
    if (result == SB_OK)
        result = regi_cpd_fill(run, &run->target, target, &run->target_frame, error);
    if (result == SB_OK)
        result = regi_cpd_fill_landmarks(run, error);
    if (result == SB_OK && o->kind == REG_CPD_NONRIGID) {
        double begun = o->clock ? o->clock() : 0.0;
        result = regi_cpd_kernel_create(&run->source, (double)o->beta, (double)o->kernel_tolerance, o->max_rank,
                                        &o->allocator, &run->kernel, error);
        run->info.rank = run->kernel.rank;
        run->info.kernel_seconds = o->clock ? o->clock() - begun : 0.0;
    }
    if (result != SB_OK)
        return result;
    for (int k = 0; k < 3; k++)
        run->map.linear[k][k] = 1;
    memcpy(run->moved, run->source.points, (size_t)run->source.blocks * sizeof *run->moved);
    run->sigma2 = sigma > 0 ? sigma * sigma : regi_cpd_spread(&run->source, &run->target);
    if (!(run->sigma2 > regi_cpd_least_sigma2))
        run->sigma2 = regi_cpd_least_sigma2;
    return SB_OK;
}

/* ---- expectation ---- */

/* 1 / sigma^2 sum |T y - x|^2 of the landmarks. */
static double regi_cpd_landmark_energy(const regi_cpd_run *run)
{
    double sum = 0;
    for (int i = 0; i < run->options.landmark_count; i++) {
        int slot = run->landmark_slots[i], lane = slot % REGI_CPD_LANES;
        const regi_cpd_block *block = run->moved + slot / REGI_CPD_LANES;
        const double *z = run->landmarks[i];
        double x = block->x[lane] - z[0], y = block->y[lane] - z[1], w = block->z[lane] - z[2];
        sum += x * x + y * y + w * w;
    }
    return run->landmark_weight * sum;
}

static sb_result regi_cpd_look(regi_cpd_run *run, int with_partners, sb_error *error)
{
    const reg_cpd_options *o = &run->options;
    regi_cpd_expectation e = run->e;
    double m = run->source.count, n = run->target.count, w = (double)o->outliers, area;
    double turn = 6.283185307179586 * run->sigma2;
    area = turn * sqrt(turn); /* the reciprocal of a Gaussian's peak */
    e.source = &run->source;
    e.target = &run->target;
    e.moved = run->moved;
    e.sigma2 = run->sigma2;
    e.outlier = area * w / (1 - w) * m / n;
    e.tolerance = (double)o->sum_tolerance;
    e.best = with_partners ? run->e.best : NULL;
    regi_cpd_bound(run->moved, run->source.blocks, run->source.boxes);
    regi_cpd_expect(&e, &o->jobs);
    memcpy(run->e.totals, e.totals, sizeof e.totals);
    if (!(e.totals[0].explained > 1e-12 * n))
        return sbi_fail(error, SB_ERROR_NOT_CONVERGED, "no target point is near enough the source: all are outliers");
    run->info.pairs += e.totals[0].pairs;
    run->info.explained = (sb_real)e.totals[0].explained;
    run->info.sigma = (sb_real)(sqrt(run->sigma2) * run->target_frame.size * run->target_frame.unit);
    run->info.objective = e.totals[0].logs + n * sbi_dense_log(m * area / (1 - w)) +
                          0.5 * ((double)o->lambda * run->energy + regi_cpd_landmark_energy(run));
    return SB_OK;
}

/* ---- maximisation ---- */

/* p and r = sum P x - p T, with the landmarks as further partners of that weight. */
static void regi_cpd_collect(regi_cpd_run *run)
{
    double weight = run->sigma2 * run->landmark_weight;
    for (int b = 0; b < run->source.blocks; b++) {
        size_t first = (size_t)b * REGI_CPD_LANES, bytes = sizeof run->e.sums[b].p;
        memcpy(run->p + first, run->e.sums[b].p, bytes);
        memcpy(run->r[0] + first, run->e.sums[b].x, bytes);
        memcpy(run->r[1] + first, run->e.sums[b].y, bytes);
        memcpy(run->r[2] + first, run->e.sums[b].z, bytes);
    }
    for (int i = 0; i < run->options.landmark_count; i++) {
        int slot = run->landmark_slots[i], lane = slot % REGI_CPD_LANES;
        const regi_cpd_block *block = run->moved + slot / REGI_CPD_LANES;
        run->p[slot] += weight;
        run->r[0][slot] += weight * (run->landmarks[i][0] - block->x[lane]);
        run->r[1][slot] += weight * (run->landmarks[i][1] - block->y[lane]);
        run->r[2][slot] += weight * (run->landmarks[i][2] - block->z[lane]);
    }
}

/* Moments of the expected pairs: `cross` of the target's with the source's points, `spread` of the source's. */
typedef struct regi_cpd_moments {
    double x[3], y[3]; /* weighted means */
    double cross[3][3], spread[3][3];
} regi_cpd_moments;

static void regi_cpd_weigh(const regi_cpd_run *run, regi_cpd_moments *s)
{
    double total = 0;
    memset(s, 0, sizeof *s);
    for (int pass = 0; pass < 2; pass++) {
        for (int i = 0; i < run->source.count; i++) {
            int b = i / REGI_CPD_LANES, l = i % REGI_CPD_LANES;
            const regi_cpd_block *from = run->source.points + b, *at = run->moved + b;
            double p = run->p[i], y[3], x[3]; /* x: p times the mean place of the partners */
            y[0] = from->x[l], y[1] = from->y[l], y[2] = from->z[l];
            x[0] = run->r[0][i] + p * at->x[l], x[1] = run->r[1][i] + p * at->y[l];
            x[2] = run->r[2][i] + p * at->z[l];
            total += pass == 0 ? p : 0.0;
            for (int j = 0; j < 3; j++) {
                s->x[j] += pass == 0 ? x[j] : 0.0;
                s->y[j] += pass == 0 ? p * y[j] : 0.0;
                for (int k = 0; k < 3 && pass == 1; k++) {
                    s->cross[j][k] += (x[j] - p * s->x[j]) * (y[k] - s->y[k]);
                    s->spread[j][k] += p * (y[j] - s->y[j]) * (y[k] - s->y[k]);
                }
            }
        }
        for (int j = 0; j < 3 && pass == 0; j++) {
            s->x[j] /= total;
            s->y[j] /= total;
        }
    }
}

/* The rotation nearest to the cross moments, times the scale. Where they say nothing the last one stays. */
static void regi_cpd_turn(regi_cpd_run *run, const regi_cpd_moments *s)
{
    double most = 0, trace = 0, spread = s->spread[0][0] + s->spread[1][1] + s->spread[2][2], scale = 1;
    sb_mat3 a, u, v, rotation;
    sb_vec3 stretches;
    for (int j = 0; j < 9; j++)
        most = regi_cpd_largest(most, fabs(s->cross[j / 3][j % 3]));
    if (!(most > 0))
        return;
    for (int j = 0; j < 9; j++)
        a.m[j / 3][j % 3] = (sb_real)(s->cross[j / 3][j % 3] / most);
    sb_m3_svd(a, &u, &stretches, &v);
    rotation = sb_m3_mult(u, v);
    for (int j = 0; j < 9; j++)
        trace += s->cross[j / 3][j % 3] * (double)rotation.m[j / 3][j % 3];
    if (run->options.kind == REG_CPD_SIMILARITY && trace > 0 && spread > 0)
        scale = trace / spread;
    for (int j = 0; j < 9; j++)
        run->map.linear[j / 3][j % 3] = scale * (double)rotation.m[j / 3][j % 3];
}

/* B += (A - B C) C^-1 of the moments A and C. C is made regular by a little: directions in which the source has no
 * extent keep the B they had, all others get theirs to 1e-10 in the first iteration, and further digits in the next. */
static void regi_cpd_stretch(regi_cpd_run *run, const regi_cpd_moments *s)
{
    double ridge = 1e-10 * (s->spread[0][0] + s->spread[1][1] + s->spread[2][2]), c[3][4], row[3];
    if (!(ridge > 0))
        return;
    for (int j = 0; j < 3; j++)
        for (int k = 0; k < 3; k++)
            c[j][k] = s->spread[j][k] + (j == k ? ridge : 0.0);
    regi_cpd_factor(c[0], 3, 4, ridge);
    for (int j = 0; j < 3; j++) {
        for (int k = 0; k < 3; k++) {
            row[k] = s->cross[j][k];
            for (int i = 0; i < 3; i++)
                row[k] -= run->map.linear[j][i] * s->spread[i][k];
        }
        regi_cpd_back_solve(c[0], 3, 4, row);
        for (int k = 0; k < 3; k++)
            run->map.linear[j][k] += row[k];
    }
}

static void regi_cpd_map(const regi_cpd_affine *map, const double y[3], double out[3])
{
    for (int j = 0; j < 3; j++)
        out[j] = map->linear[j][0] * y[0] + map->linear[j][1] * y[1] + map->linear[j][2] * y[2] + map->shift[j];
}

static void regi_cpd_move_linear(regi_cpd_run *run)
{
    regi_cpd_moments s;
    regi_cpd_weigh(run, &s);
    if (run->options.kind == REG_CPD_AFFINE)
        regi_cpd_stretch(run, &s);
    else
        regi_cpd_turn(run, &s);
    for (int j = 0; j < 3; j++) {
        run->map.shift[j] = s.x[j];
        for (int k = 0; k < 3; k++)
            run->map.shift[j] -= run->map.linear[j][k] * s.y[k];
    }
    for (int b = 0; b < run->source.blocks; b++)
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            const regi_cpd_block *from = run->source.points + b;
            double y[3], x[3];
            y[0] = from->x[l], y[1] = from->y[l], y[2] = from->z[l];
            regi_cpd_map(&run->map, y, x);
            run->next[b].x[l] = x[0], run->next[b].y[l] = x[1], run->next[b].z[l] = x[2];
        }
}

static void regi_cpd_move_freely(regi_cpd_run *run)
{
    for (int b = 0; b < run->source.blocks; b++)
        for (int l = 0; l < REGI_CPD_LANES; l++) { /* from distances to T to distances to Y */
            const regi_cpd_block *from = run->source.points + b, *at = run->moved + b;
            size_t i = (size_t)b * REGI_CPD_LANES + (size_t)l;
            run->r[0][i] += run->p[i] * (at->x[l] - from->x[l]);
            run->r[1][i] += run->p[i] * (at->y[l] - from->y[l]);
            run->r[2][i] += run->p[i] * (at->z[l] - from->z[l]);
        }
    run->energy = regi_cpd_kernel_solve(&run->kernel, run->p, run->r, (double)run->options.lambda * run->sigma2,
                                        &run->options.jobs);
    regi_cpd_kernel_move(&run->kernel, run->source.points, run->next);
}

/* sigma^2 = sum P |x - T'|^2 / (3 sum P), by the way d from T to the new T': sum P |x - T|^2 - 2 d.r + P |d|^2. */
static void regi_cpd_narrow(regi_cpd_run *run)
{
    double sum = run->e.totals[0].squares;
    for (int b = 0; b < run->source.blocks; b++)
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            const regi_cpd_sums *s = run->e.sums + b;
            double x = run->next[b].x[l] - run->moved[b].x[l], y = run->next[b].y[l] - run->moved[b].y[l];
            double z = run->next[b].z[l] - run->moved[b].z[l];
            sum += s->p[l] * (x * x + y * y + z * z) - 2 * (s->x[l] * x + s->y[l] * y + s->z[l] * z);
        }
    run->sigma2 = sum / (3 * run->e.totals[0].explained);
    if (!(run->sigma2 > regi_cpd_least_sigma2))
        run->sigma2 = regi_cpd_least_sigma2;
}

/* ---- iteration ---- */

static void regi_cpd_step(regi_cpd_run *run)
{
    regi_cpd_block *swap = run->moved;
    regi_cpd_collect(run);
    if (run->options.kind == REG_CPD_NONRIGID)
        regi_cpd_move_freely(run);
    else
        regi_cpd_move_linear(run);
    regi_cpd_narrow(run);
    run->moved = run->next;
    run->next = swap;
    run->info.iterations++;
}

/* 1 when the last iteration was the last one; why is in info.stop. */
static int regi_cpd_is_done(regi_cpd_run *run)
{
    const reg_cpd_options *o = &run->options;
    if (!(run->sigma2 > regi_cpd_least_sigma2))
        run->info.stop = REG_CPD_EXACT;
    else if (run->info.iterations > 0 && run->info.change <= o->tolerance)
        run->info.stop = REG_CPD_CONVERGED;
    else if (run->info.iterations >= o->max_iterations)
        run->info.stop = REG_CPD_ITERATIONS;
    else if (o->max_seconds > 0 && run->info.seconds >= o->max_seconds)
        run->info.stop = REG_CPD_TIME;
    else
        return 0;
    return run->info.iterations > 0 || o->max_iterations == 0;
}

static sb_result regi_cpd_iterate(regi_cpd_run *run, sb_error *error)
{
    const reg_cpd_options *o = &run->options;
    sb_result result = regi_cpd_look(run, 0, error);
    while (result == SB_OK && !regi_cpd_is_done(run)) {
        double before = run->info.objective;
        regi_cpd_step(run);
        result = regi_cpd_look(run, 0, error);
        run->info.change = (sb_real)((before - run->info.objective) / run->target.count);
        run->info.seconds = o->clock ? o->clock() - run->start : 0.0;
        if (result == SB_OK && o->progress && o->progress(o->progress_user, &run->info) != 0)
            return sbi_fail(error, SB_ERROR_CANCELLED, "stopped by the progress callback after %d iterations",
                            run->info.iterations);
    }
    return result == SB_OK ? regi_cpd_look(run, 1, error) : result;
}

/* ---- result ---- */

static void regi_cpd_fit_layout(reg_cpd *fit, sbi_arena *arena)
{
    size_t count = (size_t)fit->count, rank = (size_t)fit->info.rank;
    fit->centres = (double(*)[3])sbi_arena_take(arena, rank, 3 * sizeof(double));
    fit->weights = (double(*)[3])sbi_arena_take(arena, rank, 3 * sizeof(double));
    fit->moved = (sb_vec3 *)sbi_arena_take(arena, count, sizeof(sb_vec3));
    fit->partners = (int *)sbi_arena_take(arena, count, sizeof(int));
    fit->probabilities = (sb_real *)sbi_arena_take(arena, count, sizeof(sb_real));
}

static reg_cpd *regi_cpd_fit_allocate(const regi_cpd_run *run)
{
    const sb_allocator *allocator = &run->options.allocator;
    reg_cpd *fit = (reg_cpd *)sbi_alloc_zeroed(allocator, 1, sizeof(reg_cpd));
    sbi_arena arena;
    if (!fit)
        return NULL;
    memset(&arena, 0, sizeof arena);
    fit->allocator = *allocator;
    fit->info = run->info;
    fit->count = run->source.count;
    regi_cpd_fit_layout(fit, &arena);
    fit->memory = arena.overflow ? NULL : sbi_alloc(allocator, arena.used, 1);
    if (!fit->memory) {
        sbi_free(allocator, fit);
        return NULL;
    }
    arena.base = (unsigned char *)fit->memory;
    arena.used = 0;
    regi_cpd_fit_layout(fit, &arena);
    return fit;
}

/* Clouds near the ends of sb_real have fits beyond them. */
static sb_result regi_cpd_check_range(const regi_cpd_run *run, sb_error *error)
{
    for (int i = 0; i < run->source.count; i++) {
        const regi_cpd_block *at = run->moved + i / REGI_CPD_LANES;
        int l = i % REGI_CPD_LANES;
        double z[3];
        z[0] = at->x[l], z[1] = at->y[l], z[2] = at->z[l];
        if (!sb_v3_is_finite(regi_cpd_out_of(&run->target_frame, z)))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, run->source.order[i],
                                 "point %d of the source would move beyond what numbers hold", run->source.order[i]);
    }
    if (!sb_is_finite(run->info.sigma))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "sigma is beyond what numbers hold");
    return SB_OK;
}

static sb_result regi_cpd_finish(regi_cpd_run *run, reg_cpd **out, sb_error *error)
{
    sb_result result = regi_cpd_check_range(run, error);
    reg_cpd *fit = result == SB_OK ? regi_cpd_fit_allocate(run) : NULL;
    if (result != SB_OK)
        return result;
    if (!fit)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the fit of %d points", run->source.count);
    fit->source = run->source_frame;
    fit->target = run->target_frame;
    fit->map = run->map;
    fit->inverse = run->kernel.inverse;
    for (int i = 0; i < fit->count; i++) {
        int b = i / REGI_CPD_LANES, l = i % REGI_CPD_LANES, index = run->source.order[i];
        double z[3];
        z[0] = run->moved[b].x[l], z[1] = run->moved[b].y[l], z[2] = run->moved[b].z[l];
        fit->moved[index] = regi_cpd_out_of(&fit->target, z);
        fit->partners[index] = run->e.best[b].target[l];
        fit->probabilities[index] = (sb_real)run->e.best[b].probability[l];
    }
    if (fit->info.rank > 0)
        regi_cpd_kernel_spread(&run->kernel);
    for (int k = 0; k < fit->info.rank; k++) {
        int b = run->kernel.pivots[k] / REGI_CPD_LANES, l = run->kernel.pivots[k] % REGI_CPD_LANES;
        fit->centres[k][0] = run->source.points[b].x[l];
        fit->centres[k][1] = run->source.points[b].y[l];
        fit->centres[k][2] = run->source.points[b].z[l];
        for (int axis = 0; axis < 3; axis++)
            fit->weights[k][axis] = run->kernel.weights[axis][k];
    }
    *out = fit;
    return SB_OK;
}

REG_API sb_result reg_cpd_fit(const sb_vec3 *source, int source_count, const sb_vec3 *target, int target_count,
                              const reg_cpd_options *options, reg_cpd **fit, sb_error *error)
{
    regi_cpd_run run;
    sb_result result;
    memset(&run, 0, sizeof run);
    run.options = options ? *options : reg_default_cpd_options();
    if (!fit)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "no place for the fit");
    result = regi_cpd_check(source, source_count, target, target_count, &run.options, error);
    if (result != SB_OK)
        return result;
    run.start = run.options.clock ? run.options.clock() : 0.0;
    run.source.count = source_count;
    run.source.blocks = (source_count - 1) / REGI_CPD_LANES + 1;
    run.target.count = target_count;
    run.target.blocks = (target_count - 1) / REGI_CPD_LANES + 1;
    run.kernel.allocator = run.options.allocator;
    regi_cpd_set_frames(&run, source, source_count, target, target_count);
    result = regi_cpd_prepare(&run, source, target, error);
    if (result == SB_OK)
        result = regi_cpd_iterate(&run, error);
    if (result == SB_OK)
        result = regi_cpd_finish(&run, fit, error);
    regi_cpd_kernel_free(&run.kernel);
    sbi_free(&run.options.allocator, run.memory);
    return result;
}

REG_API void reg_cpd_destroy(reg_cpd *fit)
{
    sb_allocator allocator;
    if (!fit)
        return;
    allocator = fit->allocator;
    sbi_free(&allocator, fit->memory);
    sbi_free(&allocator, fit);
}

REG_API reg_cpd_info reg_cpd_get_info(const reg_cpd *fit)
{
    reg_cpd_info none;
    if (!fit) {
        memset(&none, 0, sizeof none);
        return none;
    }
    return fit->info;
}
REG_API const sb_vec3 *reg_cpd_moved(const reg_cpd *fit) { return fit ? fit->moved : NULL; }
REG_API const int *reg_cpd_partners(const reg_cpd *fit) { return fit ? fit->partners : NULL; }
REG_API const sb_real *reg_cpd_probabilities(const reg_cpd *fit) { return fit ? fit->probabilities : NULL; }

REG_API void reg_cpd_linear(const reg_cpd *fit, sb_mat3 *linear, sb_vec3 *translation)
{
    const regi_cpd_frame *from, *to;
    double ratio, at[3];
    if (!fit || !linear || !translation)
        return;
    from = &fit->source, to = &fit->target;
    ratio = to->unit / from->unit * (to->size / from->size);
    for (int j = 0; j < 3; j++) {
        at[j] = to->mean[j] + to->size * fit->map.shift[j]; /* in units of the target */
        for (int k = 0; k < 3; k++) {
            linear->m[j][k] = (sb_real)(ratio * fit->map.linear[j][k]);
            at[j] -= to->size / from->size * fit->map.linear[j][k] * from->mean[k];
        }
    }
    *translation = sb_v3((sb_real)(to->unit * at[0]), (sb_real)(to->unit * at[1]), (sb_real)(to->unit * at[2]));
}

REG_API void reg_cpd_apply(const reg_cpd *fit, const sb_vec3 *points, int count, sb_vec3 *moved)
{
    if (!fit || !points || !moved)
        return;
    for (int i = 0; i < count; i++) {
        double y[3], out[3];
        regi_cpd_into(&fit->source, points[i], y);
        regi_cpd_map(&fit->map, y, out);
        for (int k = 0; k < fit->info.rank; k++) {
            const double *centre = fit->centres[k], *weight = fit->weights[k];
            double dx = y[0] - centre[0], dy = y[1] - centre[1], dz = y[2] - centre[2];
            double g = sbi_dense_exp(-(dx * dx + dy * dy + dz * dz) * fit->inverse);
            for (int axis = 0; axis < 3; axis++)
                out[axis] += g * weight[axis];
        }
        moved[i] = regi_cpd_out_of(&fit->target, out);
    }
}
