/* cloud_smooth: noise and outliers of what was seen, by local fits. */
#include <string.h>

#include "../softbody/geometry/surface.h"
#include "cloud.h"

enum {
    REGI_SMOOTH_LEAST = 16,  /* neighbours of the smallest fit */
    REGI_SMOOTH_NEXT = 6,    /* those whose distance is a point's spacing */
    REGI_SMOOTH_MOST = 128,  /* and of the largest; each has twice those of the one before */
    REGI_SMOOTH_ASKED = 192, /* among which they are */
    REGI_SMOOTH_TERMS = 6,   /* 1 x y x^2 xy y^2 */
    REGI_SMOOTH_ROUNDS = 3,
    REGI_SMOOTH_BLOCK = 256 /* points per task */
};

/* What the passes over the points share. */
typedef struct regi_smooth {
    const sb_vec3 *points, *normals; /* [count]; normals NULL, or 0 where unknown */
    const reg_kdtree *tree;
    int count;
    const unsigned char *out; /* [count] 1: outliers, which no fit takes */
    sb_real noise, usual;     /* m; that of the points, and their spacing */
    sb_real *residual;        /* [count] distance from what the neighbours say, over its expected share */
    sb_real *share;           /* [count] that share: of a residual, or of what smoothing leaves, in noises */
    sb_real *scatter;         /* [count] of the neighbours about their own surface: median (m) */
    sb_real *spacing;         /* [count] mean distance to the neighbours (m) */
    sb_vec3 *moved, *facing;  /* [count] smoothed points, and the normals there */
} regi_smooth;

/* Height over a plane through a point, in a frame of its own. */
typedef struct regi_smooth_frame {
    sb_vec3 at, x, y, z;
    sb_real scale; /* m: of the neighbourhood */
} regi_smooth_frame;

/* Normal equations of heights as a quadratic of the place in the plane. */
typedef struct regi_smooth_sums {
    sb_real matrix[REGI_SMOOTH_TERMS * REGI_SMOOTH_TERMS], right[REGI_SMOOTH_TERMS];
} regi_smooth_sums;

/* The nearest points that may be used to place a point: no outliers, not of a surface that faces the other way. */
static int regi_smooth_neighbours(const regi_smooth *s, int point, int with_itself, int wanted, int *near)
{
    int found[REGI_SMOOTH_ASKED], asked = sbi_min_int(2 * wanted, REGI_SMOOTH_ASKED), count, kept = 0;
    sb_real squares[REGI_SMOOTH_ASKED];
    count = reg_kdtree_k_nearest(s->tree, s->points[point], asked, found, squares);
    for (int i = 0; i < count && kept < wanted; i++) {
        int other = found[i];
        if ((other == point && !with_itself) || (other != point && s->out[other]))
            continue;
        if (s->normals && sb_v3_dot(s->normals[point], s->normals[other]) < 0)
            continue;
        near[kept++] = other;
    }
    return kept;
}

/* Across the plane of least squares; returns 0 where the points spread in fewer than two directions. */
static int regi_smooth_place(const regi_smooth *s, int point, const int *near, int count, regi_smooth_frame *frame)
{
    sb_vec3 mean = sb_v3(0, 0, 0), values;
    sb_mat3 spread = sb_m3_zero(), vectors;
    sb_real farthest = 0;
    for (int i = 0; i < count; i++)
        mean = sb_v3_madd(mean, 1 / (sb_real)(i + 1), sb_v3_sub(s->points[near[i]], mean));
    for (int i = 0; i < count; i++) {
        sb_vec3 d = sb_v3_sub(s->points[near[i]], mean), way = sb_v3_sub(s->points[near[i]], s->points[point]);
        spread = sb_m3_add(spread, sb_m3_outer(d, d));
        farthest = sb_max(farthest, sb_v3_norm(way));
    }
    sb_m3_eigen(spread, &values, &vectors);
    frame->at = s->points[point];
    frame->x = sb_m3_column(vectors, 0);
    frame->y = sb_m3_column(vectors, 1);
    frame->z = sb_v3_cross(frame->x, frame->y);
    frame->scale = farthest;
    return farthest > 0 && values.y > 64 * SB_EPSILON * values.x;
}

static void regi_smooth_terms(const regi_smooth_frame *frame, sb_vec3 point, sb_real terms[REGI_SMOOTH_TERMS],
                              sb_real *height)
{
    sb_vec3 d = sb_v3_scale(1 / frame->scale, sb_v3_sub(point, frame->at));
    sb_real x = sb_v3_dot(d, frame->x), y = sb_v3_dot(d, frame->y);
    terms[0] = 1;
    terms[1] = x;
    terms[2] = y;
    terms[3] = x * x;
    terms[4] = x * y;
    terms[5] = y * y;
    *height = sb_v3_dot(d, frame->z) * frame->scale;
}

/* weights: NULL: all 1. */
static void regi_smooth_add(const regi_smooth *s, const regi_smooth_frame *frame, const int *near, int count,
                            const sb_real *weights, regi_smooth_sums *sums)
{
    sb_real terms[REGI_SMOOTH_TERMS], height;
    for (int i = 0; i < count; i++) {
        regi_smooth_terms(frame, s->points[near[i]], terms, &height);
        for (int a = 0; a < REGI_SMOOTH_TERMS; a++) {
            sb_real part = (weights ? weights[i] : 1) * terms[a];
            sums->right[a] += part * height;
            for (int b = 0; b <= a; b++)
                sums->matrix[a * REGI_SMOOTH_TERMS + b] += part * terms[b];
        }
    }
}

/* Coefficients, and the variance of the height at the point in those of one neighbour's. 0 when the sums do not
 * determine them. */
static int regi_smooth_solve(const regi_smooth_sums *sums, sb_real coefficients[REGI_SMOOTH_TERMS], sb_real *share)
{
    sb_real factor[REGI_SMOOTH_TERMS * REGI_SMOOTH_TERMS], first[REGI_SMOOTH_TERMS] = {1, 0, 0, 0, 0, 0};
    memcpy(factor, sums->matrix, sizeof factor);
    memcpy(coefficients, sums->right, sizeof sums->right);
    if (sb_cholesky_factor(factor, REGI_SMOOTH_TERMS))
        return 0;
    sb_cholesky_solve(factor, REGI_SMOOTH_TERMS, coefficients);
    sb_cholesky_solve(factor, REGI_SMOOTH_TERMS, first);
    *share = first[0];
    return 1;
}

/* ---- what is noise ---- */

/* Weights of a robust fit: small for those much farther off than the median, which is returned. */
static sb_real regi_smooth_doubt(const regi_smooth *s, const regi_smooth_frame *frame, const int *near, int count,
                                 const sb_real coefficients[REGI_SMOOTH_TERMS], sb_real *weights)
{
    sb_real off[REGI_SMOOTH_LEAST], sizes[REGI_SMOOTH_LEAST], terms[REGI_SMOOTH_TERMS], median;
    for (int i = 0; i < count; i++) {
        regi_smooth_terms(frame, s->points[near[i]], terms, &off[i]);
        for (int a = 0; a < REGI_SMOOTH_TERMS; a++)
            off[i] -= coefficients[a] * terms[a];
        off[i] = sb_abs(off[i]);
    }
    median = reg_outlier_limit(off, count, REG_OUTLIERS_TRIM, (sb_real)0.5, sizes);
    for (int i = 0; i < count; i++) {
        sb_real ratio = median > 0 ? off[i] / (3 * median) : 0;
        weights[i] = 1 / ((1 + ratio * ratio) * (1 + ratio * ratio));
    }
    return median;
}

/* How far a point is from the surface that its neighbours define. */
static void regi_smooth_judge(const regi_smooth *s, int point)
{
    int near[REGI_SMOOTH_LEAST], count = regi_smooth_neighbours(s, point, 0, REGI_SMOOTH_LEAST, near);
    sb_real weights[REGI_SMOOTH_LEAST], coefficients[REGI_SMOOTH_TERMS], share = 0, sum = 0;
    sb_real scatter = 0;
    regi_smooth_frame frame;
    regi_smooth_sums sums;
    int known = count > REGI_SMOOTH_TERMS && regi_smooth_place(s, point, near, count, &frame);
    for (int i = 0; i < sbi_min_int(count, REGI_SMOOTH_NEXT); i++)
        sum += sb_v3_norm(sb_v3_sub(s->points[near[i]], s->points[point]));
    s->spacing[point] = count > 0 ? sum / (sb_real)sbi_min_int(count, REGI_SMOOTH_NEXT) : 0;
    for (int round = 0; known && round < 3; round++) {
        memset(&sums, 0, sizeof sums);
        regi_smooth_add(s, &frame, near, count, round ? weights : NULL, &sums);
        known = regi_smooth_solve(&sums, coefficients, &share);
        if (known)
            scatter = regi_smooth_doubt(s, &frame, near, count, coefficients, weights);
    }
    s->scatter[point] = scatter;
    s->share[point] = known ? sb_sqrt(1 + share) : 1;
    s->residual[point] = known ? sb_abs(coefficients[0]) / s->share[point] : -1;
}

static void regi_smooth_judge_block(void *user, int block)
{
    const regi_smooth *s = (const regi_smooth *)user;
    int first = block * REGI_SMOOTH_BLOCK, last = sbi_min_int(s->count, first + REGI_SMOOTH_BLOCK);
    for (int i = first; i < last; i++)
        regi_smooth_judge(s, i);
}

static int regi_smooth_is_amid_outliers(const regi_smooth *s, int point)
{
    int near[REGI_SMOOTH_LEAST], out = 0;
    sb_real squares[REGI_SMOOTH_LEAST];
    int count = reg_kdtree_k_nearest(s->tree, s->points[point], REGI_SMOOTH_LEAST, near, squares);
    for (int i = 0; i < count; i++)
        out += s->out[near[i]];
    return 2 * out > count;
}

/* 1 for a point farther from the neighbours' surface than noise and their own spacing explain, much farther from all of
 * them than they are from theirs, or amid some that make no surface. */
static int regi_smooth_is_out(const regi_smooth *s, int point)
{
    int near[REGI_SMOOTH_LEAST], count = regi_smooth_neighbours(s, point, 0, REGI_SMOOTH_LEAST, near);
    sb_real around[REGI_SMOOTH_LEAST], sorted[REGI_SMOOTH_LEAST], usual;
    if (s->out[point])
        return 1;
    if (count < REGI_SMOOTH_LEAST)
        return regi_smooth_is_amid_outliers(s, point);
    for (int i = 0; i < count; i++)
        around[i] = s->spacing[near[i]];
    usual = reg_outlier_limit(around, count, REG_OUTLIERS_TRIM, (sb_real)0.25, sorted);
    return s->spacing[point] > (sb_real)2.5 * usual ||
           (s->spacing[point] > 2 * s->usual &&
            s->scatter[point] > sb_max(4 * s->noise, (sb_real)0.1 * s->spacing[point])) ||
           s->residual[point] > sb_max(4 * s->noise, usual / s->share[point]);
}

/* Residuals and their scale: sd of the noise across the surface. scratch[2 count] */
static void regi_smooth_measure(regi_smooth *s, const sb_jobs *jobs, sb_real *scratch)
{
    int known = 0;
    sb_real *sorted = scratch + s->count;
    sbi_run(jobs, regi_smooth_judge_block, s, (s->count - 1) / REGI_SMOOTH_BLOCK + 1);
    for (int i = 0; i < s->count; i++)
        if (s->residual[i] >= 0 && !s->out[i])
            scratch[known++] = s->residual[i];
    s->usual = reg_outlier_limit(s->spacing, s->count, REG_OUTLIERS_TRIM, (sb_real)0.5, sorted);
    s->noise = known ? (sb_real)1.4826 * reg_outlier_limit(scratch, known, REG_OUTLIERS_TRIM, (sb_real)0.5, sorted) : 0;
}

/* ---- smoothing ---- */

/* A point on the surface of a fit, and the normal there. */
static void regi_smooth_take(const regi_smooth *s, int point, const regi_smooth_frame *frame,
                             const sb_real coefficients[REGI_SMOOTH_TERMS], sb_real share)
{
    sb_vec3 normal = sb_v3_madd(sb_v3_scale(frame->scale, frame->z), -coefficients[1], frame->x);
    normal = regi_cloud_unit(sb_v3_madd(normal, -coefficients[2], frame->y));
    s->moved[point] = sb_v3_madd(s->points[point], coefficients[0], frame->z);
    if (s->normals)
        s->facing[point] = sb_v3_dot(s->normals[point], normal) < 0 ? sb_v3_scale(-1, normal) : normal;
    s->share[point] = sb_sqrt(share);
}

/* The widest fit that agrees with all narrower ones, and with the point itself, up to what noise does to each (the rule
 * of intersecting intervals: Goldenshluger, Nemirovski 1997): flat parts are smoothed widely, edges stay. An outlier
 * knows nothing of its own. */
static void regi_smooth_point(const regi_smooth *s, int point)
{
    int near[REGI_SMOOTH_MOST], count, done = 0, wanted = REGI_SMOOTH_LEAST;
    sb_real high = s->out[point] ? SB_REAL_MAX : 2 * s->noise, low = -high, share;
    sb_real coefficients[REGI_SMOOTH_TERMS];
    regi_smooth_frame frame;
    regi_smooth_sums sums;
    s->moved[point] = s->points[point];
    s->facing[point] = s->normals ? s->normals[point] : sb_v3(0, 0, 0);
    s->share[point] = 1;
    count = regi_smooth_neighbours(s, point, !s->out[point], REGI_SMOOTH_MOST, near);
    if (count < wanted || !regi_smooth_place(s, point, near, wanted, &frame))
        return;
    memset(&sums, 0, sizeof sums);
    for (; wanted <= count; wanted *= 2) {
        regi_smooth_add(s, &frame, near + done, wanted - done, NULL, &sums);
        done = wanted;
        if (!regi_smooth_solve(&sums, coefficients, &share) || !(share < 1))
            return; /* neighbours to one side say less than the point itself */
        low = sb_max(low, coefficients[0] - 2 * s->noise * sb_sqrt(share));
        high = sb_min(high, coefficients[0] + 2 * s->noise * sb_sqrt(share));
        if (low > high)
            return;
        regi_smooth_take(s, point, &frame, coefficients, share);
    }
}

static void regi_smooth_point_block(void *user, int block)
{
    const regi_smooth *s = (const regi_smooth *)user;
    int first = block * REGI_SMOOTH_BLOCK, last = sbi_min_int(s->count, first + REGI_SMOOTH_BLOCK);
    for (int i = first; i < last; i++)
        regi_smooth_point(s, i);
}

/* ---- all of it ---- */

/* What a run holds on to. */
typedef struct regi_smooth_work {
    regi_smooth pass;
    const sb_allocator *allocator;
    const sb_jobs *jobs;
    reg_kdtree *tree;
    sb_real *numbers;   /* [6 count] */
    sb_vec3 *vectors;   /* [4 count]: points, normals, moved, facing */
    unsigned char *out; /* [count] */
} regi_smooth_work;

static void regi_smooth_free(regi_smooth_work *w)
{
    reg_kdtree_destroy(w->tree);
    sbi_free(w->allocator, w->numbers);
    sbi_free(w->allocator, w->vectors);
    sbi_free(w->allocator, w->out);
}

static sb_result regi_smooth_begin(regi_smooth_work *w, const sb_vec3 *points, int count, const sb_allocator *allocator,
                                   const sb_jobs *jobs, sb_error *error)
{
    size_t n = (size_t)count;
    sb_result result;
    memset(w, 0, sizeof *w);
    w->allocator = allocator;
    w->jobs = jobs;
    result = regi_cloud_check(points, NULL, count, error);
    if (result != SB_OK)
        return result;
    w->numbers = (sb_real *)sbi_alloc(allocator, n, 6 * sizeof(sb_real));
    w->vectors = (sb_vec3 *)sbi_alloc(allocator, n, 4 * sizeof(sb_vec3));
    w->out = (unsigned char *)sbi_alloc_zeroed(allocator, n, 1);
    if (!w->numbers || !w->vectors || !w->out)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory to smooth %d points", count);
    memcpy(w->vectors, points, n * sizeof *points);
    w->pass.points = w->vectors;
    w->pass.count = count;
    w->pass.out = w->out;
    w->pass.residual = w->numbers;
    w->pass.share = w->numbers + n;
    w->pass.spacing = w->numbers + 2 * n;
    w->pass.scatter = w->numbers + 3 * n;
    w->pass.moved = w->vectors + 2 * n;
    w->pass.facing = w->vectors + 3 * n;
    return SB_OK;
}

static sb_result regi_smooth_plant(regi_smooth_work *w, sb_error *error)
{
    sb_result result;
    reg_kdtree_destroy(w->tree);
    w->tree = NULL;
    result = reg_kdtree_create(w->pass.points, w->pass.count, w->allocator, &w->tree, error);
    w->pass.tree = w->tree;
    return result;
}

/* Marks outliers until there are no more: at first they spoil what their neighbours say. Returns how many. */
static int regi_smooth_find_out(regi_smooth_work *w)
{
    unsigned char *marks = (unsigned char *)w->pass.moved; /* not in use yet */
    int n = w->pass.count, found = 0, more = 1;
    for (int round = 0; round < REGI_SMOOTH_ROUNDS && more; round++) {
        regi_smooth_measure(&w->pass, w->jobs, w->numbers + 4 * (size_t)n);
        more = 0;
        for (int i = 0; i < n; i++) {
            marks[i] = (unsigned char)regi_smooth_is_out(&w->pass, i);
            more += marks[i] - w->out[i];
        }
        memcpy(w->out, marks, (size_t)n);
    }
    for (int i = 0; i < n; i++)
        found += w->out[i];
    return found;
}

/* Noise far below the points' spacing is the surface's own curvature, or does no harm. */
static int regi_smooth_run(regi_smooth_work *w, reg_smooth_info *info)
{
    regi_smooth *s = &w->pass;
    double sum = 0;
    regi_smooth_measure(s, w->jobs, w->numbers + 4 * (size_t)s->count);
    info->noise = info->left = s->noise;
    if (!(s->noise > (sb_real)0.04 * s->usual))
        return 0;
    sbi_run(w->jobs, regi_smooth_point_block, s, (s->count - 1) / REGI_SMOOTH_BLOCK + 1);
    for (int i = 0; i < s->count; i++)
        sum += (double)(s->share[i] * s->share[i]);
    info->left = s->noise * sb_sqrt((sb_real)(sum / s->count));
    return 1;
}

REG_API sb_result reg_cloud_smooth(reg_cloud *cloud, const sb_jobs *jobs, reg_smooth_info *info, sb_error *error)
{
    regi_smooth_work w;
    reg_smooth_info found;
    sb_result result;
    int kept = 0;
    if (!cloud)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "there is no cloud to smooth");
    memset(&found, 0, sizeof found);
    result = regi_smooth_begin(&w, cloud->points, cloud->count, &cloud->allocator, jobs, error);
    w.pass.normals = cloud->normals;
    if (result == SB_OK)
        result = regi_smooth_plant(&w, error);
    if (result == SB_OK) {
        int moved;
        found.outliers = regi_smooth_find_out(&w);
        moved = regi_smooth_run(&w, &found);
        for (int i = 0; i < cloud->count; i++) {
            if (w.out[i])
                continue;
            if (cloud->normals)
                cloud->normals[kept] = moved ? w.pass.facing[i] : cloud->normals[i];
            cloud->points[kept++] = moved ? w.pass.moved[i] : cloud->points[i];
        }
        cloud->count = kept;
        if (info)
            *info = found;
    }
    regi_smooth_free(&w);
    return result;
}

/* Marks nodes whose shortest edge is three times as long as their neighbours' are on average: those that lie far away
 * from where the mesh has them, which no neighbours in space could give where many lie far away. */
static void regi_smooth_find_stretched(regi_smooth_work *w, const sbi_surface_cut *cut)
{
    int n = w->pass.count;
    sb_real *shortest = w->numbers, *sum = w->numbers + n, *count = w->numbers + 2 * (size_t)n;
    for (int i = 0; i < n; i++)
        shortest[i] = SB_REAL_MAX;
    for (int pass = 0; pass <= REGI_SMOOTH_ROUNDS; pass++) { /* the first one measures */
        for (int i = 0; i < n; i++)
            sum[i] = count[i] = 0;
        for (int k = 0; k < 6 * cut->triangles.element_count; k++) {
            const int *c = cut->triangles.elements + k / 6 * 3;
            int from = c[k % 3], to = c[(k % 3 + 1 + k % 6 / 3) % 3];
            if (pass == 0)
                shortest[to] = sb_min(shortest[to], sb_v3_norm(sb_v3_sub(w->vectors[from], w->vectors[to])));
            else
                sum[to] += w->out[from] ? 0 : shortest[from];
            count[to] += !w->out[from];
        }
        for (int i = 0; i < n && pass > 0; i++)
            w->out[i] = w->out[i] || (count[i] > 0 && shortest[i] * count[i] > 3 * sum[i]);
    }
}

/* Puts outliers amid their neighbours in the mesh, those next to good nodes first. What only has outliers around it
 * stays. */
static void regi_smooth_recall(regi_smooth_work *w, const sbi_surface_cut *cut)
{
    size_t n = (size_t)w->pass.count;
    sb_vec3 *sums = w->pass.moved;
    int *counts = (int *)w->pass.facing, left = 1;
    unsigned char *lost = (unsigned char *)w->numbers;
    memcpy(lost, w->out, n);
    while (left) {
        left = 0;
        memset(sums, 0, n * sizeof *sums);
        memset(counts, 0, n * sizeof *counts);
        for (int k = 0; k < 3 * cut->triangles.element_count; k++) {
            const int *c = cut->triangles.elements + k / 3 * 3;
            int to = c[k % 3];
            for (int j = 1; j < 3 && lost[to]; j++) {
                int from = c[(k + j) % 3];
                if (lost[from])
                    continue;
                sums[to] = sb_v3_add(sums[to], w->vectors[from]);
                counts[to]++;
            }
        }
        for (size_t i = 0; i < n; i++)
            if (counts[i] > 0) {
                w->vectors[i] = sb_v3_scale(1 / (sb_real)counts[i], sums[i]);
                lost[i] = 0;
                left = 1;
            }
    }
}

REG_API sb_result reg_cloud_smooth_mesh(sb_mesh *surface, const sb_jobs *jobs, reg_smooth_info *info, sb_error *error)
{
    regi_smooth_work w;
    reg_smooth_info found;
    sbi_surface_cut cut;
    sb_result result;
    if (!surface)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "there is no surface to smooth");
    memset(&found, 0, sizeof found);
    result = sbi_surface_cut_make(surface, &surface->allocator, &cut, error);
    if (result != SB_OK)
        return result;
    result = regi_smooth_begin(&w, surface->nodes, surface->node_count, &surface->allocator, jobs, error);
    if (result == SB_OK)
        result = regi_smooth_plant(&w, error);
    if (result == SB_OK) {
        regi_smooth_find_stretched(&w, &cut);
        found.outliers = regi_smooth_find_out(&w);
        regi_smooth_recall(&w, &cut);
        result = regi_smooth_plant(&w, error);
    }
    if (result == SB_OK) {
        sb_vec3 *normals = w.vectors + w.pass.count, *kept = cut.triangles.nodes;
        cut.triangles.nodes = w.vectors;
        regi_cloud_face_normals(&cut, normals);
        cut.triangles.nodes = kept;
        w.pass.normals = normals;
        memcpy(surface->nodes, regi_smooth_run(&w, &found) ? w.pass.moved : w.pass.points,
               (size_t)surface->node_count * sizeof(sb_vec3));
        if (info)
            *info = found;
    }
    regi_smooth_free(&w);
    sbi_surface_cut_free(&surface->allocator, &cut);
    return result;
}
