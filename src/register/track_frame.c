/* track_frame: what is known of an organ's pose and shape, from one frame to the next. */
#include "track_private.h"

#include <math.h>
#include <string.h>

#include "../softbody/base/eigen.h"

/* ---- a start, and time that goes by ---- */

REGI_API void regi_track_open(const reg_track *t, regi_track_known *known, const sb_real sd[2])
{
    size_t n = (size_t)t->unknowns;
    memset(known->covariance, 0, n * n * sizeof *known->covariance);
    memset(known->evidence, 0, sizeof known->evidence);
    memset(known->change_evidence, 0, sizeof known->change_evidence);
    known->scale = 1;
    for (int k = 0; k < t->unknowns; k++) {
        int pose = k - t->def.modes;
        double deviation = pose < 0 ? known->scale : (double)sd[pose / 3];
        known->covariance[(size_t)k * n + (size_t)k] = deviation * deviation;
    }
    known->wide = REGI_TRACK_WIDE;
    known->usual_used = known->usual_innovation = 0;
    known->surprises = 0;
}

/* Copies but for the arrays, which stay. */
static void regi_track_copy_small(const regi_track_known *from, regi_track_known *to)
{
    double *mean = to->mean, *covariance = to->covariance;
    *to = *from;
    to->mean = mean;
    to->covariance = covariance;
}

REGI_API void regi_track_predict(reg_track *t, double dt)
{
    size_t n = (size_t)t->unknowns, q = (size_t)t->def.modes;
    double kept = sbi_dense_exp(-dt / (double)t->def.memory);
    regi_track_copy_small(&t->known, &t->next);
    for (size_t k = 0; k < q; k++)
        t->next.mean[k] = kept * t->known.mean[k];
    for (size_t k = 0; k < n; k++)
        for (size_t l = 0; l < n; l++)
            t->next.covariance[k * n + l] = (k < q ? kept : 1) * (l < q ? kept : 1) * t->known.covariance[k * n + l];
    for (size_t k = 0; k < n; k++) {
        double rate = (double)(k < q + 3 ? t->def.wander : t->def.turn);
        t->next.covariance[k * n + k] += k < q ? (1 - kept * kept) * t->known.scale * t->known.scale : rate * rate * dt;
    }
    t->next.time += dt;
    t->next.blind += dt;
}

REGI_API sb_real regi_track_expected(const reg_track *t, const regi_track_known *known)
{
    size_t n = (size_t)t->unknowns;
    double sum = 0;
    for (size_t k = 0; k < n * n; k++)
        sum += known->covariance[k] * t->spread[k];
    return (sb_real)REGI_TRACK_ALPHA * sb_sqrt((sb_real)(sum > 0 ? sum : 0));
}

/* ---- looking ---- */

/* The pose of the state at hand. */
static void regi_track_pose(const reg_track *t, sb_vec3 *place, sb_quat *turned)
{
    const double *way = t->state + t->def.modes;
    sb_vec3 move = sb_v3((sb_real)way[0], (sb_real)way[1], (sb_real)way[2]);
    sb_vec3 turn = sb_v3((sb_real)way[3], (sb_real)way[4], (sb_real)way[5]);
    *place = sb_v3_add(t->next.place, sb_m3_apply(sb_quat_to_mat3(t->next.turned), move));
    *turned = sb_quat_normalise(sb_quat_mul(t->next.turned, sb_quat_from_rotation_vector(turn)));
}

/* Where points of these arms and shapes are in the state at hand: moved[count]. */
static void regi_track_move(const reg_track *t, const sb_vec3 *arms, const double *modes, int count, sb_vec3 place,
                            sb_mat3 rotation, sb_vec3 *moved)
{
    size_t q = (size_t)t->def.modes;
    for (int i = 0; i < count; i++) {
        const double *mode = modes + (size_t)i * 3 * q;
        double sum[3] = {0, 0, 0};
        for (int axis = 0; axis < 3; axis++)
            for (size_t k = 0; k < q; k++)
                sum[axis] += mode[(size_t)axis * q + k] * t->state[k];
        moved[i] = sb_v3_add(arms[i], sb_v3((sb_real)sum[0], (sb_real)sum[1], (sb_real)sum[2]));
        moved[i] = sb_v3_add(place, sb_m3_apply(rotation, moved[i]));
    }
}

/* Finds the places of the points that came in, and sorts them by the patch that these are in. */
static void regi_track_sort_points(reg_track *t)
{
    int *start = t->look.patch_start;
    memset(start, 0, (size_t)(t->patch_count + 1) * sizeof *start);
    for (int i = 0; i < t->incoming_count; i++) {
        regi_look_point *p = t->incoming + i;
        regi_look_place(&t->look, p);
        p->patch = p->triangle < 0 ? 0 : t->patch_of[p->triangle];
        start[p->patch + 1]++;
    }
    for (int s = 0; s < t->patch_count; s++)
        start[s + 1] += start[s];
    for (int i = 0; i < t->incoming_count; i++)
        t->look.points[start[t->incoming[i].patch]++] = t->incoming[i];
    memmove(start + 1, start, (size_t)t->patch_count * sizeof *start);
    start[0] = 0;
    t->look.point_count = t->incoming_count;
}

/* How far off points are followed at least (m): as far as is expected, and a coarse model may be off; in the frames
 * after a start as far as loads may well have moved the organ. */
static sb_real regi_track_early_limit(const reg_track *t)
{
    sb_real size = t->model->size, wide = (sb_real)0.08 * size;
    sb_real limit = sb_max((sb_real)0.01 * size, sb_min(wide, 3 * regi_track_expected(t, &t->next)));
    for (int k = t->next.wide; k < REGI_TRACK_WIDE; k++)
        wide *= (sb_real)0.5;
    return t->next.wide > 0 ? sb_max(wide, limit) : limit;
}

static sb_result regi_track_look(reg_track *t, sb_error *error)
{
    sb_vec3 place;
    sb_quat turned;
    sb_mat3 rotation;
    sb_result result;
    regi_track_pose(t, &place, &turned);
    rotation = sb_quat_to_mat3(turned);
    regi_track_move(t, t->mark_arms, t->mark_modes, t->marks.count, place, rotation, t->marks.places);
    regi_marks_follow(&t->marks);
    regi_track_move(t, t->skin_arms, t->skin_modes, t->skin_count, place, rotation, t->skin);
    result = sb_surface_move(t->tree, t->skin, &t->model->jobs, error);
    if (result != SB_OK)
        return result;
    regi_track_sort_points(t);
    regi_look_judge(&t->look, regi_track_early_limit(t), t->next.wide > 0 ? 4 : 6);
    return SB_OK;
}

/* ---- rows ---- */

/* Adds w of what amounts of the shapes do along a line (in the frame of the organ) to a point of these. */
static void regi_track_add_modes(const reg_track *t, const double *mode, double w, sb_vec3 line, double *row)
{
    size_t q = (size_t)t->def.modes;
    double x = w * (double)line.x, y = w * (double)line.y, z = w * (double)line.z;
    for (size_t k = 0; k < q; k++)
        row[k] += x * mode[k] + y * mode[q + k] + z * mode[2 * q + k];
}

/* And what the pose does to a point with this arm from the middle. */
static void regi_track_add_pose(const reg_track *t, sb_vec3 arm, sb_vec3 line, double *row)
{
    sb_vec3 turn = sb_v3_cross(arm, line);
    row += t->def.modes;
    row[0] += (double)line.x, row[1] += (double)line.y, row[2] += (double)line.z;
    row[3] += (double)turn.x, row[4] += (double)turn.y, row[5] += (double)turn.z;
}

/* Adds what the state does to a point along its plane's normal. */
static void regi_track_add_point(const reg_track *t, const regi_look_point *p, sb_vec3 place, sb_mat3 rotation,
                                 double *row)
{
    const int *corners = t->model->skin.elements + 3 * (size_t)p->triangle;
    sb_vec3 line = sb_v3_scale(p->share, sb_m3_tapply(rotation, p->plane));
    for (int c = 0; c < 3; c++)
        regi_track_add_modes(t, t->skin_modes + (size_t)corners[c] * 3 * (size_t)t->def.modes, (double)p->corner[c],
                             line, row);
    regi_track_add_pose(t, sb_m3_tapply(rotation, sb_v3_sub(p->place, place)), line, row);
}

/* The row of a patch and its gap, over its deviation. */
static void regi_track_fill_row(reg_track *t, int patch, sb_vec3 place, sb_mat3 rotation, double *row, double *gap)
{
    double misfit = (double)t->def.misfit, scale = regi_look_share_patch(&t->look, patch);
    scale = 1 / (double)sb_sqrt((sb_real)(scale + misfit * misfit));
    memset(row, 0, (size_t)t->unknowns * sizeof *row);
    *gap = 0;
    for (int i = t->look.patch_start[patch]; i < t->look.patch_start[patch + 1]; i++) {
        const regi_look_point *p = t->look.points + i;
        if (!(p->share > 0) || p->triangle < 0)
            continue;
        *gap += scale * (double)(p->share * p->gap);
        regi_track_add_point(t, p, place, rotation, row);
    }
    for (int k = 0; k < t->unknowns; k++)
        row[k] *= scale;
}

/* Rows and gaps of the patches that count; returns how many, and what share of the surface they are. */
static int regi_track_fill_rows(reg_track *t, sb_real *seen)
{
    sb_real least = regi_look_least_trust(&t->look);
    int count = 0;
    double area = 0;
    sb_vec3 place;
    sb_quat turned;
    sb_mat3 rotation;
    regi_track_pose(t, &place, &turned);
    rotation = sb_quat_to_mat3(turned);
    for (int s = 0; s < t->patch_count; s++)
        if (regi_look_patch_trust(&t->look, s) > least) {
            regi_track_fill_row(t, s, place, rotation, t->rows + (size_t)count * (size_t)t->unknowns, t->gaps + count);
            area += t->patch_area[s];
            count++;
        }
    *seen = (sb_real)(area / t->model->area);
    return count;
}

/* ---- the filter ---- */

/* inverse[n][n] of the factor at hand. */
static void regi_track_invert(const double *factor, int n, double *column, double *inverse)
{
    for (int k = 0; k < n; k++) {
        memset(column, 0, (size_t)n * sizeof *column);
        column[k] = 1;
        regi_gauss_substitute(factor, n, (size_t)n, column);
        for (int l = 0; l <= k; l++)
            inverse[(size_t)k * (size_t)n + (size_t)l] = inverse[(size_t)l * (size_t)n + (size_t)k] = column[l];
    }
}

/* information: what rows tell of the state; pull: where they draw it from the forecast, and whole: from amounts of 0.
 */
static void regi_track_gather(reg_track *t, int count)
{
    size_t n = (size_t)t->unknowns;
    memset(t->information, 0, n * n * sizeof *t->information);
    regi_gauss_add_squares(t->wide, t->information, t->unknowns, t->rows, count, n);
    memset(t->pull, 0, n * sizeof *t->pull);
    memset(t->whole, 0, n * sizeof *t->whole);
    for (int i = 0; i < count; i++) {
        const double *row = t->rows + (size_t)i * n;
        double now = 0, before = 0;
        for (size_t k = 0; k < n; k++) {
            now += row[k] * t->state[k];
            before += row[k] * t->forecast[k];
        }
        for (size_t k = 0; k < n; k++) {
            t->pull[k] += (t->gaps[i] + now - before) * row[k];
            t->whole[k] += (t->gaps[i] + now) * row[k];
        }
    }
}

/* Squared gaps over what was expected of them before the target, mean. The state is the forecast. -1: not positive. */
static double regi_track_surprise(reg_track *t, int count)
{
    size_t n = (size_t)t->unknowns;
    double squares = 0, explained = 0;
    memcpy(t->precise, t->next.covariance, n * n * sizeof *t->precise);
    if (!regi_gauss_cholesky(t->wide, t->precise, t->unknowns, n))
        return -1;
    regi_track_invert(t->precise, t->unknowns, t->column, t->precision);
    for (size_t k = 0; k < n * n; k++)
        t->precise[k] = t->precision[k] + t->information[k];
    if (!regi_gauss_cholesky(t->wide, t->precise, t->unknowns, n))
        return -1;
    memset(t->column, 0, n * sizeof *t->column);
    for (int i = 0; i < count; i++) {
        squares += t->gaps[i] * t->gaps[i];
        for (size_t k = 0; k < n; k++)
            t->column[k] += t->gaps[i] * t->rows[(size_t)i * n + k];
    }
    memcpy(t->precision, t->column, n * sizeof *t->precision); /* is not needed any more */
    regi_gauss_substitute(t->precise, t->unknowns, n, t->column);
    for (size_t k = 0; k < n; k++)
        explained += t->column[k] * t->precision[k];
    return (squares - explained) / count;
}

/* prior[6][6]: the precision of the pose before the target. 0: it is not positive. */
static int regi_track_weigh_pose(reg_track *t)
{
    double factor[REGI_TRACK_POSE * REGI_TRACK_POSE];
    size_t n = (size_t)t->unknowns, q = (size_t)t->def.modes;
    for (size_t k = 0; k < REGI_TRACK_POSE; k++)
        for (size_t l = 0; l < REGI_TRACK_POSE; l++)
            factor[k * REGI_TRACK_POSE + l] = t->next.covariance[(q + k) * n + q + l];
    if (!regi_gauss_cholesky(0, factor, REGI_TRACK_POSE, REGI_TRACK_POSE))
        return 0;
    regi_track_invert(factor, REGI_TRACK_POSE, t->column, t->pose_precision);
    return 1;
}

/* precise: the upper half of information and the pose's prior. */
static void regi_track_add_pose_prior(reg_track *t)
{
    size_t n = (size_t)t->unknowns, q = (size_t)t->def.modes;
    memcpy(t->precise, t->information, n * n * sizeof *t->precise);
    for (size_t k = 0; k < REGI_TRACK_POSE; k++)
        for (size_t l = k; l < REGI_TRACK_POSE; l++)
            t->precise[(q + k) * n + q + l] += t->pose_precision[k * REGI_TRACK_POSE + l];
}

/* along[q]: pull without what the pose, of this factor, takes of it. */
static void regi_track_reduce_pull(const reg_track *t, const double *factor, const double *pull, double *along)
{
    size_t n = (size_t)t->unknowns, q = (size_t)t->def.modes;
    double part[REGI_TRACK_POSE];
    memcpy(part, pull + q, sizeof part);
    regi_gauss_substitute(factor, REGI_TRACK_POSE, REGI_TRACK_POSE, part);
    for (size_t a = 0; a < q; a++) {
        along[a] = pull[a];
        for (size_t k = 0; k < REGI_TRACK_POSE; k++)
            along[a] -= t->precise[a * n + q + k] * part[k];
    }
}

/* Takes the pose out of information, pull and whole: small[q][q], full, along[q] and beyond[q] are of the amounts
 * alone. */
static int regi_track_reduce(reg_track *t)
{
    size_t n = (size_t)t->unknowns, q = (size_t)t->def.modes;
    double factor[REGI_TRACK_POSE * REGI_TRACK_POSE];
    regi_track_add_pose_prior(t);
    for (size_t k = 0; k < REGI_TRACK_POSE; k++)
        for (size_t l = k; l < REGI_TRACK_POSE; l++)
            factor[k * REGI_TRACK_POSE + l] = t->precise[(q + k) * n + q + l];
    if (!regi_gauss_cholesky(0, factor, REGI_TRACK_POSE, REGI_TRACK_POSE))
        return 0;
    regi_track_reduce_pull(t, factor, t->pull, t->along);
    regi_track_reduce_pull(t, factor, t->whole, t->beyond);
    for (size_t a = 0; a < q; a++) {
        double solved[REGI_TRACK_POSE];
        memcpy(solved, t->precise + a * n + q, sizeof solved);
        regi_gauss_substitute(factor, REGI_TRACK_POSE, REGI_TRACK_POSE, solved);
        for (size_t b = a; b < q; b++) {
            double sum = t->precise[a * n + b];
            for (size_t k = 0; k < REGI_TRACK_POSE; k++)
                sum -= solved[k] * t->precise[b * n + q + k];
            t->small[a * q + b] = t->small[b * q + a] = sum;
        }
    }
    return 1;
}

/* log evidence of a scale of the amounts, by elimination of small made tridiagonal; along is turned with it. */
static double regi_track_evidence(const reg_track *t, const double *along, double scale)
{
    double square = scale * scale, pivot = 1, part = 0, sum = 0;
    for (int k = 0; k < t->def.modes; k++) {
        double beside = k > 0 ? square * t->beside[k - 1] : 0, ratio = beside / pivot;
        pivot = 1 + square * t->diagonal[k] - ratio * beside;
        pivot = pivot > 1 ? pivot : 1; /* for rounding */
        part = along[k] - ratio * part;
        sum += square * part * part / pivot - sbi_dense_log(pivot);
    }
    return 0.5 * sum;
}

/* The scale of the most evidence, faded in, of those from 1/128 to 2, a factor of sqrt2 apart. */
static double regi_track_best_scale(const reg_track *t, const double *along, double fresh, double *evidence)
{
    double scale = 0.0078125, best = scale, most = 0;
    for (int k = 0; k < REGI_TRACK_SCALES; k++) {
        evidence[k] += fresh * (regi_track_evidence(t, along, scale) - evidence[k]);
        if (k == 0 || evidence[k] > most) {
            most = evidence[k];
            best = scale;
        }
        scale *= 1.4142135623730951;
    }
    return best;
}

/* Chooses the scales: of the change since the forecast, and of the amounts. */
static int regi_track_choose(reg_track *t)
{
    if (!regi_track_reduce(t))
        return 0;
    sbi_symmetric_tridiagonalise(t->small, t->def.modes, t->diagonal, t->beside, t->column, t->turns);
    sbi_symmetric_turn(t->small, t->def.modes, t->column, t->along);
    sbi_symmetric_turn(t->small, t->def.modes, t->column, t->beyond);
    t->next.change = regi_track_best_scale(t, t->along, t->fresh, t->next.change_evidence);
    t->next.scale = regi_track_best_scale(t, t->beyond, t->fresh, t->next.evidence);
    return t->diagonal[t->def.modes - 1] < 1e300; /* not NaN */
}

/* precise: the factor of information, the pose before, and amounts of a scale. 0: not positive. */
static int regi_track_factor(reg_track *t, double scale)
{
    size_t n = (size_t)t->unknowns;
    regi_track_add_pose_prior(t);
    for (int k = 0; k < t->def.modes; k++)
        t->precise[(size_t)k * n + (size_t)k] += 1 / (scale * scale);
    return regi_gauss_cholesky(t->wide, t->precise, t->unknowns, n);
}

/* The state that information and pull, the pose before and a change of the scale suggest. */
static int regi_track_solve(reg_track *t)
{
    size_t n = (size_t)t->unknowns;
    if (!regi_track_factor(t, t->next.change))
        return 0;
    memcpy(t->state, t->pull, n * sizeof *t->state);
    regi_gauss_substitute(t->precise, t->unknowns, n, t->state);
    for (size_t k = 0; k < n; k++)
        t->state[k] += t->forecast[k];
    return t->state[0] < 1e300; /* not NaN */
}

/* next: the state at hand. What is open of it is what amounts of their scale leave open, not the change alone: what
 * the frames before were off by, this one is, too. */
static int regi_track_settle(reg_track *t)
{
    sb_vec3 place;
    sb_quat turned;
    if (!regi_track_factor(t, t->next.scale))
        return 0;
    regi_track_pose(t, &place, &turned);
    t->next.place = place;
    t->next.turned = turned;
    memcpy(t->next.mean, t->state, (size_t)t->def.modes * sizeof *t->state);
    regi_track_invert(t->precise, t->unknowns, t->column, t->next.covariance);
    if (t->look.point_count > 0)
        t->next.noise = t->look.noise;
    t->next.blind = 0;
    return 1;
}

/* ---- landmarks and curves ---- */

/* The row of a line and its gap (m). */
static void regi_track_fill_line(const reg_track *t, const regi_marks_line *line, sb_vec3 place, sb_mat3 rotation,
                                 double *row, double *gap)
{
    sb_vec3 at = sb_v3(0, 0, 0), axis = sb_m3_tapply(rotation, line->axis);
    memset(row, 0, (size_t)t->unknowns * sizeof *row);
    for (int end = 0; end < 2; end++) {
        sb_real part = end ? line->share : 1 - line->share;
        size_t mark = (size_t)line->points[end];
        at = sb_v3_madd(at, part, t->marks.places[mark]);
        regi_track_add_modes(t, t->mark_modes + mark * 3 * (size_t)t->def.modes, (double)part, axis, row);
    }
    regi_track_add_pose(t, sb_m3_tapply(rotation, sb_v3_sub(at, place)), axis, row);
    *gap = (double)sb_v3_dot(sb_v3_sub(line->seen, at), line->axis);
}

/* What the target alone says: precision becomes the covariance that it leaves, and column the state. information and
 * pull are of its patches. 0: not positive. */
static int regi_track_weigh_target(reg_track *t)
{
    size_t n = (size_t)t->unknowns;
    if (!regi_track_factor(t, t->next.scale))
        return 0;
    regi_track_invert(t->precise, t->unknowns, t->column, t->precision);
    memcpy(t->column, t->pull, n * sizeof *t->column);
    regi_gauss_substitute(t->precise, t->unknowns, n, t->column);
    for (size_t k = 0; k < n; k++)
        t->column[k] += t->forecast[k];
    return 1;
}

/* How much `count` lines (2 or 3) of one feature count, whose rows[count][unknowns], gaps (m) and variance (m^2) these
 * are: less the farther they are off what the target says, for what that leaves open. */
static double regi_track_trust_lines(const reg_track *t, const double *rows, const double *gaps, double variance,
                                     int count)
{
    const double freedom = 3, open = REGI_TRACK_ALPHA * REGI_TRACK_ALPHA / variance;
    size_t n = (size_t)t->unknowns;
    sb_mat3 expected = sb_m3_identity(), inverse;
    double off[3] = {0, 0, 0}, squares;
    sb_vec3 along;
    for (int a = 0; a < count; a++) {
        const double *row = rows + (size_t)a * n;
        off[a] = gaps[a];
        for (size_t k = 0; k < n; k++)
            off[a] += row[k] * (t->state[k] - t->column[k]);
        for (int b = 0; b <= a; b++) {
            const double *other = rows + (size_t)b * n;
            double sum = 0;
            for (size_t k = 0; k < n; k++) {
                double part = 0;
                for (size_t l = 0; l < n; l++)
                    part += t->precision[k * n + l] * other[l];
                sum += row[k] * part;
            }
            expected.m[a][b] = expected.m[b][a] = (sb_real)(open * sum + (a == b));
        }
    }
    if (sb_m3_spd_inverse(expected, &inverse) != 0)
        return 0;
    along = sb_v3((sb_real)off[0], (sb_real)off[1], (sb_real)off[2]);
    squares = (double)sb_v3_dot(along, sb_m3_apply(inverse, along)) / variance;
    return squares > count ? (freedom + count) / (freedom + squares) : 1;
}

/* Adds rows and gaps of the lines of landmarks and curves behind those of `count` patches; returns how many there are
 * then. */
static int regi_track_fill_lines(reg_track *t, int count, sb_real *trusted)
{
    size_t n = (size_t)t->unknowns;
    double least = 1e-4 * (double)t->model->size, misfit = (double)t->def.misfit, sum = 0;
    int features = 0, width;
    sb_vec3 place;
    sb_quat turned;
    sb_mat3 rotation;
    regi_track_pose(t, &place, &turned);
    rotation = sb_quat_to_mat3(turned);
    for (int first = 0; first < t->marks.line_count; first += width) {
        double *rows = t->rows + (size_t)count * n, *gaps = t->gaps + count, variance, trust, scale;
        width = first < t->marks.fixed_count ? 3 : 2;
        /* three samples of a curve are as far apart as two patches are: what the shapes miss is one for them */
        variance = t->marks.lines[first].variance + least * least + (width == 2 ? 3 : 1) * misfit * misfit;
        for (int k = 0; k < width; k++)
            regi_track_fill_line(t, t->marks.lines + first + k, place, rotation, rows + (size_t)k * n, gaps + k);
        trust = regi_track_trust_lines(t, rows, gaps, variance, width);
        scale = sqrt(trust / variance);
        for (size_t k = 0; k < (size_t)width * n; k++)
            rows[k] *= scale;
        for (int k = 0; k < width; k++)
            gaps[k] *= scale;
        sum += trust;
        features++;
        count += width;
    }
    *trusted = (sb_real)(features > 0 ? sum / features : 0);
    return count;
}

static sb_result regi_track_take_look(reg_track *t, int look, int *counted, reg_track_info *info)
{
    sb_real p95;
    sb_result result = regi_track_look(t, &info->error);
    if (result != SB_OK)
        return result;
    *counted = regi_track_fill_rows(t, &info->seen);
    regi_look_measure(&t->look, &info->used, &info->residual, &p95);
    regi_track_gather(t, *counted);
    if (t->marks.line_count > 0) {
        if (!regi_track_weigh_target(t))
            return sbi_fail(&info->error, SB_ERROR_INDEFINITE, "what is known of the organ is not positive any more");
        *counted = regi_track_fill_lines(t, *counted, &info->trusted);
        regi_track_gather(t, *counted);
    }
    if (*counted == 0)
        return SB_OK;
    if (look == 0) {
        info->innovation = (sb_real)regi_track_surprise(t, *counted);
        if (info->innovation < 0 || !regi_track_choose(t))
            return sbi_fail(&info->error, SB_ERROR_INDEFINITE, "what is known of the organ is not positive any more");
    }
    if (!regi_track_solve(t))
        return sbi_fail(&info->error, SB_ERROR_INDEFINITE, "the target cannot be taken in");
    return SB_OK;
}

REGI_API sb_result regi_track_take_in(reg_track *t, int *counted, reg_track_info *info)
{
    sb_result result = SB_OK;
    memset(t->state, 0, (size_t)t->unknowns * sizeof *t->state);
    memcpy(t->state, t->next.mean, (size_t)t->def.modes * sizeof *t->state);
    memcpy(t->forecast, t->state, (size_t)t->unknowns * sizeof *t->state);
    t->look.has_camera = t->incoming_has_camera;
    t->look.camera = t->incoming_camera;
    *counted = 0;
    if (!t->waiting)
        t->incoming_count = 0;
    if (!regi_track_weigh_pose(t))
        return sbi_fail(&info->error, SB_ERROR_INDEFINITE, "what is known of the pose is not positive any more");
    for (int look = 0; look < REGI_TRACK_LOOKS && (look == 0 || *counted > 0); look++) {
        result = regi_track_take_look(t, look, counted, info);
        if (result != SB_OK)
            return result;
    }
    if (*counted > 0 && !regi_track_settle(t))
        return sbi_fail(&info->error, SB_ERROR_INDEFINITE, "the target cannot be taken in");
    info->noise = t->next.noise;
    return result;
}
