/* infer_marks: landmarks, and lines of the organ that are seen (curves), as rows of an inference. */
#include "infer_private.h"

#include <math.h>
#include <string.h>

enum { REGI_INFER_MOST_MARKS = 1000, REGI_INFER_MOST_SAMPLES = 32 };

/* Places that a curve is seen at are so far apart, in sizes of the organ. */
static const double regi_infer_sample_apart = 0.02;
/* Cosine of the angle up to which a piece of the model's line and one of what is seen may be the same. */
static const double regi_infer_same_way = 0.7;

/* ---- checks ---- */

static sb_result regi_infer_check_landmarks(const reg_infer_def *def, sb_error *error)
{
    if (def->landmark_count < 0 || def->landmark_count > REGI_INFER_MOST_MARKS ||
        (def->landmark_count > 0 && !def->landmarks))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d landmarks: out of range, or without an array",
                        def->landmark_count);
    for (int i = 0; i < def->landmark_count; i++) {
        if (!sb_v3_is_finite(def->landmarks[i].model) || !sb_v3_is_finite(def->landmarks[i].seen))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "landmark %d is not finite", i);
        if (!(def->landmarks[i].sd >= 0))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "sd of landmark %d is below 0", i);
    }
    return SB_OK;
}

static int regi_infer_are_finite(const sb_vec3 *points, int count)
{
    for (int i = 0; i < count; i++)
        if (!sb_v3_is_finite(points[i]))
            return 0;
    return 1;
}

/* m */
static sb_real regi_infer_length(const sb_vec3 *corners, int count)
{
    sb_real sum = 0;
    for (int i = 0; i + 1 < count; i++)
        sum += sb_v3_norm(sb_v3_sub(corners[i + 1], corners[i]));
    return sum;
}

static sb_result regi_infer_check_curve(const reg_curve *curve, int index, sb_error *error)
{
    if (!curve->model || !curve->seen || curve->model_count < 2 || curve->seen_count < 2 ||
        curve->model_count > REGI_INFER_MOST_MARKS)
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, index,
                             "curve %d of %d corners, seen at %d: needs two of each, and %d of the model at most",
                             index, curve->model_count, curve->seen_count, (int)REGI_INFER_MOST_MARKS);
    if (!(curve->sd > 0))
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, index, "sd of curve %d is not above 0", index);
    if (!regi_infer_are_finite(curve->model, curve->model_count) ||
        !regi_infer_are_finite(curve->seen, curve->seen_count))
        return sbi_fail_node(error, SB_ERROR_NOT_FINITE, index, "curve %d is not finite", index);
    if (!(regi_infer_length(curve->model, curve->model_count) > 0) ||
        !(regi_infer_length(curve->seen, curve->seen_count) > 0))
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, index, "curve %d has no length", index);
    return SB_OK;
}

REGI_API sb_result regi_infer_check_marks(const reg_infer_def *def, sb_error *error)
{
    sb_result result = regi_infer_check_landmarks(def, error);
    if (result != SB_OK)
        return result;
    if (def->curve_count < 0 || def->curve_count > REGI_INFER_MOST_MARKS || (def->curve_count > 0 && !def->curves))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d curves: out of range, or without an array", def->curve_count);
    for (int i = 0; i < def->curve_count && result == SB_OK; i++)
        result = regi_infer_check_curve(def->curves + i, i, error);
    return result;
}

/* ---- what there is ---- */

/* At how many places a curve is seen; 0: it counts nothing. */
static int regi_infer_samples_of(const reg_infer *f, const reg_curve *curve)
{
    double apart = regi_infer_sample_apart * (double)f->model->size;
    double wanted = ceil((double)regi_infer_length(curve->seen, curve->seen_count) / apart);
    if (!sb_is_finite(curve->sd))
        return 0;
    return wanted < (int)REGI_INFER_MOST_SAMPLES ? (int)wanted : (int)REGI_INFER_MOST_SAMPLES;
}

REGI_API void regi_infer_count_marks(reg_infer *f)
{
    for (int i = 0; i < f->def->landmark_count; i++)
        f->landmark_count += sb_is_finite(f->def->landmarks[i].sd);
    f->mark_count = f->landmark_count;
    for (int i = 0; i < f->def->curve_count; i++) {
        int samples = regi_infer_samples_of(f, f->def->curves + i);
        f->sample_count += samples;
        f->mark_count += samples > 0 ? f->def->curves[i].model_count : 0;
    }
}

static void regi_infer_take_landmarks(reg_infer *f)
{
    int mark = 0;
    for (int i = 0; i < f->def->landmark_count; i++) {
        const reg_landmark *landmark = f->def->landmarks + i;
        if (!sb_is_finite(landmark->sd))
            continue;
        f->mark_places[mark] = landmark->model;
        for (int k = 0; k < 3; k++) {
            regi_infer_line *line = f->lines + 3 * mark + k;
            line->points[0] = line->points[1] = mark;
            line->share = 0;
            line->axis = sb_v3(k == 0, k == 1, k == 2);
            line->seen = landmark->seen;
            line->variance = (double)landmark->sd * (double)landmark->sd;
        }
        mark++;
    }
    f->line_count = 3 * mark;
}

/* The middles of `count` pieces of one length that what is seen of a curve is cut into. */
static void regi_infer_sample_curve(const reg_curve *curve, int first, int count, regi_infer_sample *samples)
{
    sb_real length = regi_infer_length(curve->seen, curve->seen_count), behind = 0;
    int corner = 0;
    for (int k = 0; k < count; k++) {
        sb_real at = length * ((sb_real)k + (sb_real)0.5) / (sb_real)count;
        sb_vec3 along = sb_v3_sub(curve->seen[corner + 1], curve->seen[corner]);
        sb_real way = sb_v3_norm(along);
        while (corner + 2 < curve->seen_count && behind + way < at) {
            behind += way;
            corner++;
            along = sb_v3_sub(curve->seen[corner + 1], curve->seen[corner]);
            way = sb_v3_norm(along);
        }
        samples[k].tangent = sb_v3_scale(way > 0 ? 1 / way : 0, along);
        samples[k].seen = sb_v3_madd(curve->seen[corner], sb_min(at - behind, way), samples[k].tangent);
        samples[k].variance = (double)curve->sd * (double)curve->sd;
        samples[k].first = first;
        samples[k].count = curve->model_count;
    }
}

static void regi_infer_take_curves(reg_infer *f)
{
    int mark = f->landmark_count, sample = 0;
    for (int i = 0; i < f->def->curve_count; i++) {
        const reg_curve *curve = f->def->curves + i;
        int count = regi_infer_samples_of(f, curve);
        if (count == 0)
            continue;
        memcpy(f->mark_places + mark, curve->model, (size_t)curve->model_count * sizeof *curve->model);
        regi_infer_sample_curve(curve, mark, count, f->samples + sample);
        mark += curve->model_count;
        sample += count;
    }
}

REGI_API sb_result regi_infer_take_marks(reg_infer *f, sb_error *error)
{
    sb_embedding_def embed = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_result result;
    if (f->mark_count == 0)
        return SB_OK;
    regi_infer_take_landmarks(f);
    regi_infer_take_curves(f);
    embed.mesh = &f->model->mesh;
    embed.points = f->mark_places;
    embed.point_count = f->mark_count;
    embed.kind = SB_EMBED_PLAIN;
    embed.max_distance = (sb_real)0.25 * f->model->size;
    embed.allocator = f->allocator;
    embed.jobs = f->model->jobs;
    result = sb_embedding_create(&embed, &embedding, error);
    if (result == SB_OK)
        result = sb_embedding_mapping(embedding, &f->allocator, &f->marks, error);
    sb_embedding_destroy(embedding);
    return result;
}

/* ---- rows ---- */

/* The nearest place on the model's line where that goes the way that is seen: by a share of the way from the mark that
 * is told to the next one. -1: there is none. */
static int regi_infer_find_on_curve(const reg_infer *f, const regi_infer_sample *sample, sb_real *share)
{
    sb_real nearest = SB_REAL_MAX;
    int found = -1;
    for (int i = sample->first; i + 1 < sample->first + sample->count; i++) {
        sb_vec3 from = f->mark_places[i], way = sb_v3_sub(f->mark_places[i + 1], from), off;
        sb_real length = sb_v3_norm(way), at;
        if (!(length > 0) || !(sb_abs(sb_v3_dot(way, sample->tangent)) > (sb_real)regi_infer_same_way * length))
            continue;
        at = sb_v3_dot(sb_v3_sub(sample->seen, from), way) / (length * length);
        at = sb_min(sb_max(at, 0), 1);
        off = sb_v3_sub(sample->seen, sb_v3_madd(from, at, way));
        if (sb_v3_dot(off, off) < nearest) {
            nearest = sb_v3_dot(off, off);
            *share = at;
            found = i;
        }
    }
    return found;
}

/* The two lines across the model's one, from where a sample has its place. */
static void regi_infer_add_sample(reg_infer *f, const regi_infer_sample *sample, int from, sb_real share)
{
    regi_infer_line *line = f->lines + f->line_count;
    sb_vec3 way = sb_v3_sub(f->mark_places[from + 1], f->mark_places[from]);
    sb_vec3 along = sb_v3_scale(1 / sb_v3_norm(way), way);
    line->points[0] = from;
    line->points[1] = from + 1;
    line->share = share;
    line->axis = sb_v3_perpendicular(along);
    line->seen = sample->seen;
    line->variance = sample->variance;
    line[1] = line[0];
    line[1].axis = sb_v3_cross(along, line->axis);
    f->line_count += 2;
}

REGI_API void regi_infer_follow_curves(reg_infer *f)
{
    f->line_count = 3 * f->landmark_count;
    if (f->sample_count > 0)
        sb_mapping_apply(&f->marks.mapping, sb_body_positions(f->model->body), f->mark_places);
    for (int i = 0; i < f->sample_count; i++) {
        sb_real share = 0;
        int from = regi_infer_find_on_curve(f, f->samples + i, &share);
        if (from >= 0)
            regi_infer_add_sample(f, f->samples + i, from, share);
    }
}

REGI_API void regi_infer_add_line(const reg_infer *f, const regi_infer_line *line, sb_vec3 *row, double *gap,
                                  sb_vec3 *place)
{
    const sb_mapping *mapping = &f->marks.mapping;
    const sb_vec3 *x = sb_body_positions(f->model->body);
    *place = sb_v3(0, 0, 0);
    for (int end = 0; end < 2; end++) {
        sb_real part = end ? line->share : 1 - line->share;
        for (int k = mapping->row_start[line->points[end]]; k < mapping->row_start[line->points[end] + 1]; k++) {
            int node = mapping->nodes[k];
            *place = sb_v3_madd(*place, part * mapping->weights[k], x[node]);
            row[node] = sb_v3_madd(row[node], part * mapping->weights[k], line->axis);
        }
    }
    *gap = (double)sb_v3_dot(sb_v3_sub(line->seen, *place), line->axis);
}
