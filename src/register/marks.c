/* marks: see marks.h. */
#include "marks.h"

#include <math.h>
#include <string.h>

enum { REGI_MARKS_MOST = 1000 };

/* Places that a curve is seen at are so far apart, in sizes of the organ. */
static const double regi_marks_apart = 0.02;
/* Cosine of the angle up to which a piece of the model's line and one of what is seen may be the same. */
static const double regi_marks_same_way = 0.7;

/* ---- checks ---- */

/* m */
static sb_real regi_marks_length(const sb_vec3 *corners, int count)
{
    sb_real sum = 0;
    for (int i = 0; i + 1 < count; i++)
        sum += sb_v3_norm(sb_v3_sub(corners[i + 1], corners[i]));
    return sum;
}

/* Corners of a line, of the model or seen. */
static sb_result regi_marks_check_corners(const sb_vec3 *corners, int count, int index, sb_error *error)
{
    for (int i = 0; i < count; i++)
        if (!sb_v3_is_finite(corners[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, index, "curve %d is not finite", index);
    if (!(regi_marks_length(corners, count) > 0))
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, index, "curve %d has no length", index);
    return SB_OK;
}

static sb_result regi_marks_check_line(const reg_curve *curve, int index, sb_error *error)
{
    if (!curve->model || curve->model_count < 2 || curve->model_count > REGI_MARKS_MOST)
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, index, "curve %d of %d corners: needs two, and %d at most",
                             index, curve->model ? curve->model_count : 0, (int)REGI_MARKS_MOST);
    return regi_marks_check_corners(curve->model, curve->model_count, index, error);
}

REGI_API sb_result regi_marks_check_model(const regi_marks_def *def, sb_error *error)
{
    sb_result result = SB_OK;
    if (def->landmark_count < 0 || def->landmark_count > REGI_MARKS_MOST ||
        (def->landmark_count > 0 && !def->landmarks))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d landmarks: out of range, or without an array",
                        def->landmark_count);
    for (int i = 0; i < def->landmark_count; i++)
        if (!sb_v3_is_finite(def->landmarks[i].model))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "landmark %d is not finite", i);
    if (def->curve_count < 0 || def->curve_count > REGI_MARKS_MOST || (def->curve_count > 0 && !def->curves))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d curves: out of range, or without an array", def->curve_count);
    for (int i = 0; i < def->curve_count && result == SB_OK; i++)
        result = regi_marks_check_line(def->curves + i, i, error);
    return result;
}

/* SB_ERROR_ARGUMENT for a place that no organ of this size moves to: most often one of other units. */
static sb_result regi_marks_check_near(sb_vec3 seen, sb_vec3 about, sb_real far, const char *what, int index,
                                       sb_error *error)
{
    sb_real way = sb_v3_norm(sb_v3_sub(seen, about));
    if (way <= far)
        return SB_OK;
    return sbi_fail_node(error, SB_ERROR_ARGUMENT, index, "%s %d is seen %g m from the organ: in other units?", what,
                         index, (double)way);
}

static sb_result regi_marks_check_landmark(const reg_landmark *landmark, int index, sb_vec3 about, sb_real far,
                                           sb_error *error)
{
    if (!(landmark->sd >= 0))
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, index, "sd of landmark %d is below 0", index);
    if (!sb_is_finite(landmark->sd))
        return SB_OK;
    if (!sb_v3_is_finite(landmark->seen))
        return sbi_fail_node(error, SB_ERROR_NOT_FINITE, index, "landmark %d is not finite", index);
    return regi_marks_check_near(landmark->seen, about, far, "landmark", index, error);
}

static sb_result regi_marks_check_curve(const reg_curve *curve, int index, sb_vec3 about, sb_real far, sb_error *error)
{
    sb_result result;
    if (!(curve->sd > 0))
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, index, "sd of curve %d is not above 0", index);
    if (!sb_is_finite(curve->sd))
        return SB_OK;
    if (!curve->seen || curve->seen_count < 2)
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, index, "curve %d is seen at %d corners: needs two", index,
                             curve->seen ? curve->seen_count : 0);
    result = regi_marks_check_corners(curve->seen, curve->seen_count, index, error);
    for (int i = 0; i < curve->seen_count && result == SB_OK; i++)
        result = regi_marks_check_near(curve->seen[i], about, far, "curve", index, error);
    return result;
}

REGI_API sb_result regi_marks_check_seen(const regi_marks_def *def, sb_vec3 about, sb_real far, sb_error *error)
{
    sb_result result = SB_OK;
    for (int i = 0; i < def->landmark_count && result == SB_OK; i++)
        result = regi_marks_check_landmark(def->landmarks + i, i, about, far, error);
    for (int i = 0; i < def->curve_count && result == SB_OK; i++)
        result = regi_marks_check_curve(def->curves + i, i, about, far, error);
    return result;
}

/* ---- what there is ---- */

/* At how many places a curve is seen; 0: it counts nothing. */
static int regi_marks_samples_of(const regi_marks *m, const reg_curve *curve)
{
    double wanted;
    if (!sb_is_finite(curve->sd))
        return 0;
    wanted = ceil((double)regi_marks_length(curve->seen, curve->seen_count) / (regi_marks_apart * (double)m->size));
    return wanted < (int)REGI_MARKS_SAMPLES ? (int)wanted : (int)REGI_MARKS_SAMPLES;
}

/* 1: a mark. */
static int regi_marks_has_landmark(const regi_marks_def *def, int index)
{
    return def->all || sb_is_finite(def->landmarks[index].sd);
}

static int regi_marks_has_curve(const regi_marks_def *def, int index)
{
    return def->all || sb_is_finite(def->curves[index].sd);
}

REGI_API void regi_marks_count(regi_marks *m, const regi_marks_def *def, sb_real size)
{
    m->size = size;
    m->landmark_count = m->most_samples = 0;
    m->curve_count = def->curve_count;
    for (int i = 0; i < def->landmark_count; i++)
        m->landmark_count += regi_marks_has_landmark(def, i);
    m->count = m->landmark_count;
    for (int i = 0; i < def->curve_count; i++)
        if (regi_marks_has_curve(def, i)) {
            m->count += def->curves[i].model_count;
            m->most_samples += def->all ? (int)REGI_MARKS_SAMPLES : regi_marks_samples_of(m, def->curves + i);
        }
}

REGI_API int regi_marks_most_lines(const regi_marks *m) { return 3 * m->landmark_count + 2 * m->most_samples; }

REGI_API void regi_marks_layout(regi_marks *m, sbi_arena *arena)
{
    m->starts = (int *)sbi_arena_take(arena, (size_t)m->curve_count + 1, sizeof(int));
    m->seen = (int *)sbi_arena_take(arena, (size_t)m->landmark_count + (size_t)m->curve_count, sizeof(int));
    m->places = (sb_vec3 *)sbi_arena_take(arena, (size_t)m->count, sizeof(sb_vec3));
    m->lines = (regi_marks_line *)sbi_arena_take(arena, (size_t)regi_marks_most_lines(m), sizeof(regi_marks_line));
    m->samples = (regi_marks_sample *)sbi_arena_take(arena, (size_t)m->most_samples, sizeof(regi_marks_sample));
}

REGI_API sb_result regi_marks_place(regi_marks *m, const regi_marks_def *def, const sb_mesh *mesh,
                                    const sb_allocator *allocator, const sb_jobs *jobs, sb_error *error)
{
    sb_embedding_def embed = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_result result;
    int mark = 0;
    if (m->count == 0)
        return SB_OK;
    for (int i = 0; i < def->landmark_count; i++)
        if (regi_marks_has_landmark(def, i))
            m->places[mark++] = def->landmarks[i].model;
    m->starts[0] = mark;
    for (int i = 0; i < def->curve_count; i++) {
        const reg_curve *curve = def->curves + i;
        if (regi_marks_has_curve(def, i)) {
            memcpy(m->places + mark, curve->model, (size_t)curve->model_count * sizeof *curve->model);
            mark += curve->model_count;
        }
        m->starts[i + 1] = mark;
    }
    embed.mesh = mesh;
    embed.points = m->places;
    embed.point_count = m->count;
    embed.kind = SB_EMBED_PLAIN;
    embed.max_distance = (sb_real)0.25 * m->size;
    embed.allocator = *allocator;
    embed.jobs = *jobs;
    result = sb_embedding_create(&embed, &embedding, error);
    if (result == SB_OK)
        result = sb_embedding_mapping(embedding, allocator, &m->rows, error);
    sb_embedding_destroy(embedding);
    return result;
}

/* ---- what is seen ---- */

REGI_API void regi_marks_index(regi_marks *m)
{
    m->fixed_count = m->sample_count = 0;
    for (int mark = 0; mark < m->landmark_count; mark++)
        for (int k = 0; k < 3 && m->seen[mark]; k++) {
            regi_marks_line *line = m->lines + m->fixed_count++;
            *line = line[-k];
            line->points[0] = line->points[1] = mark;
            line->share = 0;
            line->axis = sb_v3(k == 0, k == 1, k == 2);
        }
    for (int i = 0; i < m->curve_count; i++)
        for (int k = 0; k < m->seen[m->landmark_count + i]; k++) {
            regi_marks_sample *sample = m->samples + m->sample_count++;
            sample->first = m->starts[i];
            sample->count = m->starts[i + 1] - m->starts[i];
        }
    m->line_count = m->fixed_count;
}

REGI_API void regi_marks_forget(regi_marks *m)
{
    for (int i = 0; i < m->landmark_count + m->curve_count; i++)
        m->seen[i] = 0;
    regi_marks_index(m);
}

/* The middles of `count` pieces of one length that what is seen of a curve is cut into. */
static void regi_marks_sample_curve(const reg_curve *curve, int count, regi_marks_sample *samples)
{
    sb_real length = regi_marks_length(curve->seen, curve->seen_count), behind = 0;
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
    }
}

REGI_API void regi_marks_see(regi_marks *m, const regi_marks_def *def)
{
    int mark = 0, seen = 0, samples = 0;
    for (int i = 0; i < def->landmark_count; i++) {
        const reg_landmark *landmark = def->landmarks + i;
        int counts = sb_is_finite(landmark->sd);
        if (counts) {
            m->lines[3 * seen].seen = landmark->seen;
            m->lines[3 * seen++].variance = (double)landmark->sd * (double)landmark->sd;
        }
        if (regi_marks_has_landmark(def, i))
            m->seen[mark++] = counts;
    }
    for (int i = 0; i < def->curve_count; i++) {
        int count = regi_marks_samples_of(m, def->curves + i);
        if (count > 0)
            regi_marks_sample_curve(def->curves + i, count, m->samples + samples);
        m->seen[m->landmark_count + i] = count;
        samples += count;
    }
    regi_marks_index(m);
}

/* The nearest place on the model's line where that goes the way that is seen: by a share of the way from the mark that
 * is told to the next one. -1: there is none. */
static int regi_marks_find_on_curve(const regi_marks *m, const regi_marks_sample *sample, sb_real *share)
{
    sb_real nearest = SB_REAL_MAX;
    int found = -1;
    for (int i = sample->first; i + 1 < sample->first + sample->count; i++) {
        sb_vec3 from = m->places[i], way = sb_v3_sub(m->places[i + 1], from), off;
        sb_real length = sb_v3_norm(way), at;
        if (!(length > 0) || !(sb_abs(sb_v3_dot(way, sample->tangent)) > (sb_real)regi_marks_same_way * length))
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
static void regi_marks_add_sample(regi_marks *m, const regi_marks_sample *sample, int from, sb_real share)
{
    regi_marks_line *line = m->lines + m->line_count;
    sb_vec3 way = sb_v3_sub(m->places[from + 1], m->places[from]);
    sb_vec3 along = sb_v3_scale(1 / sb_v3_norm(way), way);
    line->points[0] = from;
    line->points[1] = from + 1;
    line->share = share;
    line->axis = sb_v3_perpendicular(along);
    line->seen = sample->seen;
    line->variance = sample->variance;
    line[1] = line[0];
    line[1].axis = sb_v3_cross(along, line->axis);
    m->line_count += 2;
}

REGI_API void regi_marks_follow(regi_marks *m)
{
    m->line_count = m->fixed_count;
    for (int i = 0; i < m->sample_count; i++) {
        sb_real share = 0;
        int from = regi_marks_find_on_curve(m, m->samples + i, &share);
        if (from >= 0)
            regi_marks_add_sample(m, m->samples + i, from, share);
    }
}
