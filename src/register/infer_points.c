/* infer_points: what an inference says of points of the organ, and which of them is worth touching. */
#include <math.h>
#include <string.h>

#include "infer_private.h"

/* Points of the organ at rest by its nodes. */
static sb_result regi_infer_hold_points(const reg_infer *f, const sb_vec3 *points, int count, sb_embedding_rows *rows,
                                        sb_error *error)
{
    sb_embedding_def embed = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_result result;
    memset(rows, 0, sizeof *rows);
    embed.mesh = &f->model->mesh;
    embed.points = points;
    embed.point_count = count;
    embed.kind = SB_EMBED_PLAIN;
    embed.max_distance = (sb_real)0.25 * f->model->size;
    embed.allocator = f->allocator;
    embed.jobs = f->model->jobs;
    result = sb_embedding_create(&embed, &embedding, error);
    if (result == SB_OK)
        result = sb_embedding_mapping(embedding, &f->allocator, rows, error);
    sb_embedding_destroy(embedding);
    return result;
}

/* Motion of a row's point by u[nodes]. */
static sb_vec3 regi_infer_point_motion(const sb_mapping *mapping, int point, const sb_vec3 *u)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int k = mapping->row_start[point]; k < mapping->row_start[point + 1]; k++)
        sum = sb_v3_madd(sum, mapping->weights[k], u[mapping->nodes[k]]);
    return sum;
}

static sb_vec3 regi_infer_point_error(const reg_infer *f, const sb_mapping *mapping, int point, int draw)
{
    return regi_infer_point_motion(mapping, point, f->errors + (size_t)draw * (size_t)f->node_count);
}

/* ---- where points are ---- */

/* From the draws. The inverse of a covariance of n draws of three is too large by (n - 1)/(n - 5) on the mean: that
 * factor makes regions of confidence right. */
static sb_mat3 regi_infer_point_covariance(const reg_infer *f, const sb_mapping *mapping, int point)
{
    sb_mat3 sum = sb_m3_zero();
    for (int k = 0; k < REG_INFER_DRAWS; k++) {
        sb_vec3 e = regi_infer_point_error(f, mapping, point, k);
        sum = sb_m3_add(sum, sb_m3_outer(e, e));
    }
    return sb_m3_scale(1 / (sb_real)(REG_INFER_DRAWS - 4), sum);
}

REG_API sb_result reg_infer_covariance(const reg_infer *infer, const sb_vec3 *points, int count, sb_vec3 *moved,
                                       sb_mat3 *covariances, sb_error *error)
{
    sb_embedding_rows rows;
    sb_result result;
    if (!infer || !points || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "covariances need an inference, and %d points", count);
    result = regi_infer_hold_points(infer, points, count, &rows, error);
    for (int i = 0; result == SB_OK && i < count; i++) {
        if (moved)
            moved[i] = sb_v3_add(points[i], regi_infer_point_motion(&rows.mapping, i, infer->shape));
        if (covariances)
            covariances[i] = regi_infer_point_covariance(infer, &rows.mapping, i);
    }
    sb_embedding_rows_free(&rows);
    return result;
}

/* ---- the landmark worth having ---- */

/* Mean over the nodes of the error to expect once a point is known whose draws are errors[DRAWS], to sd along each
 * axis: regression of the nodes' draws on the point's, ridge sd^2. Three that are fitted to n draws take a share of
 * 3 / n of what they tell nothing of: hence n / (n - 3), by which no node gets worse than it was. */
static double regi_infer_expect_after(const reg_infer *f, const sb_vec3 errors[REG_INFER_DRAWS], double sd)
{
    const double draws = REG_INFER_DRAWS;
    sb_mat3 own = sb_m3_zero(), inverse;
    sb_real ridge;
    double sum = 0;
    for (int k = 0; k < REG_INFER_DRAWS; k++)
        own = sb_m3_add(own, sb_m3_outer(errors[k], errors[k]));
    own = sb_m3_scale((sb_real)(1 / draws), own);
    ridge = (sb_real)(sd * sd) + SB_EPSILON * (sb_m3_trace(own) + SB_EPSILON * f->model->size * f->model->size);
    inverse = sb_m3_inverse(sb_m3_add(own, sb_m3_scale(ridge, sb_m3_identity()))); /* of an exact one, too */
    for (int i = 0; i < f->node_count; i++) {
        sb_mat3 cross = sb_m3_zero();
        double before = (double)f->expected[i] * (double)f->expected[i], after;
        for (int k = 0; k < REG_INFER_DRAWS; k++)
            cross = sb_m3_add(cross, sb_m3_outer(f->errors[(size_t)k * (size_t)f->node_count + (size_t)i], errors[k]));
        cross = sb_m3_scale((sb_real)(1 / draws), cross);
        after = before - (double)sb_m3_trace(sb_m3_mul(sb_m3_mul(cross, inverse), sb_m3_transpose(cross)));
        after *= draws / (draws - 3);
        after = after < 0 ? 0 : after < before ? after : before;
        sum += sqrt(after) / f->node_count;
    }
    return sum;
}

REG_API sb_result reg_infer_best_landmark(const reg_infer *infer, const sb_vec3 *points, int count, sb_real sd,
                                          int *best, sb_real *expected, sb_error *error)
{
    sb_embedding_rows rows;
    double least = 0;
    int first = -1;
    sb_real far;
    sb_result result;
    if (!infer || !points || !best || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the best landmark is one of some points of an inference: %d points",
                        count);
    if (!sb_is_finite(sd) || sd < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a landmark's deviation must be finite and not negative, is %g",
                        (double)sd);
    far = (sb_real)1e6 * infer->model->size; /* tells nothing, and has a square */
    result = regi_infer_hold_points(infer, points, count, &rows, error);
    for (int i = 0; result == SB_OK && i < count; i++) {
        sb_vec3 errors[REG_INFER_DRAWS];
        double after;
        for (int k = 0; k < REG_INFER_DRAWS; k++)
            errors[k] = regi_infer_point_error(infer, &rows.mapping, i, k);
        after = regi_infer_expect_after(infer, errors, (double)sb_min(sd, far));
        if (first < 0 || after < least) {
            first = i;
            least = after;
        }
    }
    sb_embedding_rows_free(&rows);
    if (result != SB_OK)
        return result;
    *best = first;
    if (expected)
        *expected = (sb_real)least;
    return SB_OK;
}
