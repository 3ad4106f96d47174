/* icp: the call: what it accepts, its last stage, and what it reports. */
#include "icp_private.h"

enum { REGI_ICP_COOKIE = 0x72696370 };

REG_API reg_icp_options reg_default_icp_options(void)
{
    reg_icp_options options;
    memset(&options, 0, sizeof options);
    options.metric = REG_ICP_PLANE;
    options.search = 1;
    options.start = reg_rigid_identity();
    options.outliers = REG_OUTLIERS_MEDIAN;
    options.outlier_parameter = 3;
    options.max_distance = SB_REAL_MAX;
    options.sample = 2000;
    options.max_iterations = 100;
    options.tolerance = (sb_real)1e-6;
    options.max_seconds = 10;
    options.cookie = REGI_ICP_COOKIE;
    return options;
}

REG_API const char *reg_icp_stop_string(reg_icp_stop stop)
{
    switch (stop) {
    case REG_ICP_CONVERGED: return "converged";
    case REG_ICP_ITERATIONS: return "iterations";
    case REG_ICP_TIME: return "time";
    }
    return "unknown";
}

REG_API const char *reg_warning_string(reg_warning warning)
{
    switch (warning) {
    case REG_WARN_AMBIGUOUS: return "ambiguous";
    case REG_WARN_INVERTED: return "inverted normals";
    case REG_WARN_MIXED_NORMALS: return "mixed normals";
    case REG_WARN_SCALE: return "scale";
    case REG_WARN_VIEW_SMALL: return "small view";
    case REG_WARN_MANY_OUTLIERS: return "many outliers";
    case REG_WARN_LOW_CONTRAST: return "low contrast";
    case REG_WARN_FREE_SPACE: return "free space";
    case REG_WARN_STRAIN: return "strain";
    case REG_WARN_VOLUME: return "volume";
    case REG_WARN_NOT_AT_REST: return "not at rest";
    }
    return "unknown";
}

/* ==== checks ====================================================================================================== */

static sb_result regi_icp_check(const reg_icp_shape *shape, const char *which, sb_error *error)
{
    sb_result result = regi_cloud_check(shape->points, shape->normals, shape->count, error);
    sb_real most = 0;
    if (result != SB_OK)
        return result;
    for (int i = 0; shape->weights && i < shape->count; i++) {
        if (!(shape->weights[i] >= 0) || !sb_is_finite(shape->weights[i]))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "the weight of the %s's point %d is %g", which, i,
                                 (double)shape->weights[i]);
        most = sb_max(most, shape->weights[i]);
    }
    if (shape->weights && !(most > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "all weights of the %s are 0", which);
    for (int i = 0; shape->sd && i < shape->count; i++)
        if (!(shape->sd[i] > 0) || !sb_is_finite(shape->sd[i]))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "the sd of the %s's point %d is %g", which, i,
                                 (double)shape->sd[i]);
    if (!sb_v3_is_finite(shape->camera))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the camera of the %s is not finite", which);
    if (shape->tree && reg_kdtree_count(shape->tree) != shape->count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the %s has %d points, its tree %d", which, shape->count,
                        reg_kdtree_count(shape->tree));
    return SB_OK;
}

static sb_result regi_icp_check_landmarks(const reg_icp_options *o, sb_error *error)
{
    if (o->landmark_count < 0 || (o->landmark_count > 0 && !o->landmarks))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d landmarks without an array", o->landmark_count);
    for (int i = 0; i < o->landmark_count; i++) {
        const reg_icp_landmark *l = o->landmarks + i;
        if (!sb_v3_is_finite(l->model) || !sb_v3_is_finite(l->target))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "landmark %d is not finite", i);
        if (!(l->weight > 0) || !sb_is_finite(l->weight))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "the weight of landmark %d is %g", i, (double)l->weight);
    }
    return SB_OK;
}

static sb_result regi_icp_check_options(const reg_icp_options *o, sb_error *error)
{
    sb_real one = 1, scratch;
    if (o->cookie != REGI_ICP_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the options do not come from reg_default_icp_options()");
    if ((int)o->overlap < REG_ICP_WHOLE || (int)o->overlap > REG_ICP_MODEL_PART)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d is no kind of overlap", (int)o->overlap);
    if ((int)o->metric < REG_ICP_POINT || (int)o->metric > REG_ICP_PLANE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d is no metric", (int)o->metric);
    if (!(o->max_distance > 0) || o->sample < 0 || o->max_iterations < 1 || !(o->tolerance >= 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_distance, sample, max_iterations or tolerance is out of range");
    if (o->clock && !(o->max_seconds > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_seconds is %g, it must be positive", o->max_seconds);
    if (!sb_v3_is_finite(o->start.translation) || !sb_is_finite(sbi_dense_max_abs(&o->start.rotation.m[0][0], 9)))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the start is not finite");
    if (!(o->start_shift_sd >= 0) || !(o->start_turn_sd >= 0) || !(o->seen_from_sd >= 0) ||
        !sb_is_finite(o->start_shift_sd + o->start_turn_sd + o->seen_from_sd))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a deviation of the start or of seen_from is out of range");
    if (!sb_v3_is_finite(o->seen_from))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "seen_from is not finite");
    if (o->seen_from_sd > 0 && !(sb_v3_norm(o->seen_from) > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "seen_from is 0, but seen_from_sd is not");
    if (reg_outlier_limit(&one, 1, o->outliers, o->outlier_parameter, &scratch) < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "outlier rule %d with the parameter %g is out of range",
                        (int)o->outliers, (double)o->outlier_parameter);
    return regi_icp_check_landmarks(o, error);
}

static sb_result regi_icp_make_pairs(regi_icp *icp)
{
    int landmarks = icp->options->landmark_count;
    int points = sbi_max_int(icp->a.sample.count, icp->a.spread.count);
    int others = sbi_max_int(icp->b.sample.count, icp->b.spread.count);
    int most = icp->both ? points + others : sbi_max_int(points, others);
    size_t room = (size_t)most + (size_t)landmarks;
    regi_icp_pairs *p = &icp->pairs;
    p->from = (sb_vec3 *)sbi_alloc(icp->allocator, room, 3 * sizeof(sb_vec3));
    p->weight = (sb_real *)sbi_alloc(icp->allocator, room, 3 * sizeof(sb_real));
    icp->landmarks_a = (sb_vec3 *)sbi_alloc(icp->allocator, (size_t)landmarks, 2 * sizeof(sb_vec3));
    if (!p->from || !p->weight || !icp->landmarks_a)
        return regi_icp_no_memory(icp);
    p->to = p->from + room;
    p->normal = p->to + room;
    p->distance = p->weight + room;
    p->scratch = p->distance + room;
    icp->landmarks_b = icp->landmarks_a + landmarks;
    for (int i = 0; i < landmarks; i++) {
        const reg_icp_landmark *l = icp->options->landmarks + i;
        icp->landmarks_a[i] = icp->swapped ? l->target : l->model;
        icp->landmarks_b[i] = icp->swapped ? l->model : l->target;
    }
    return SB_OK;
}

/* ==== the call ==================================================================================================== */

static void regi_icp_tell(regi_icp *icp, const reg_rigid *motion, reg_icp_info *info)
{
    sb_real total = 0, squares = 0;
    for (int i = 0; i < icp->options->landmark_count; i++) {
        sb_vec3 gap = sb_v3_sub(reg_rigid_apply(motion, icp->landmarks_a[i]), icp->landmarks_b[i]);
        squares += icp->options->landmarks[i].weight * sb_v3_dot(gap, gap);
        total += icp->options->landmarks[i].weight;
    }
    info->pairs = regi_icp_measure(&icp->pairs, &info->mean, &info->rms);
    info->overlap = (sb_real)info->pairs / (sb_real)sbi_max_int(icp->pairs.count, 1);
    info->landmark_rms = total > 0 ? sb_sqrt(squares / total) : 0;
    info->seconds = icp->options->clock ? icp->options->clock() - icp->begun : 0;
}

/* Which way fitted normals point is not known (an outlier on top turns them all): the way that lets more pairs be. */
static int regi_icp_find_flip(regi_icp *icp, const regi_icp_stage *last, const reg_rigid *motion)
{
    regi_icp_stage stage = *last;
    sb_real as_they_are;
    stage.lost = (sb_real)0.25 * icp->a.size;
    as_they_are = regi_icp_pair(icp, &stage, motion);
    stage.flip = -1;
    return regi_icp_pair(icp, &stage, motion) < as_they_are ? -1 : 1;
}

/* The poses to begin the last stage with, the likeliest first. */
static sb_result regi_icp_begin(regi_icp *icp, const reg_rigid *start, const regi_icp_stage *stage, regi_pose *poses,
                                reg_icp_info *info)
{
    if (icp->options->search)
        return regi_pose_search(icp, start, stage, poses, &info->pose_count, &info->candidates);
    memset(poses, 0, sizeof poses[0]);
    poses[0].motion = *start;
    poses[0].flip = icp->a.unsure || icp->b.unsure ? regi_icp_find_flip(icp, stage, start) : 1;
    info->pose_count = 1;
    return SB_OK;
}

/* Whether so many nats tell two poses apart. */
static int regi_icp_is_clear(sb_real nats) { return nats >= 3; }

/* The poses and how clearly they are told apart; motions of the model from here on. */
static void regi_icp_tell_poses(regi_icp *icp, const regi_pose *poses, reg_icp_info *info)
{
    for (int i = 0; i < info->pose_count; i++) {
        info->poses[i] = regi_icp_of_model(icp, &poses[i].motion);
        info->likelihood[i] = poses[i].likelihood - poses[0].likelihood;
    }
    info->margin = info->pose_count > 1 ? -info->likelihood[1] : SB_REAL_MAX;
    if (!regi_icp_is_clear(info->margin))
        icp->warnings |= REG_WARN_AMBIGUOUS;
    if (poses[0].flip < 0 && !icp->a.fitted && !icp->b.fitted)
        icp->warnings |= REG_WARN_INVERTED;
}

/* The last stage for the poses that may be the right one as well as the first. */
static void regi_icp_refine_others(regi_icp *icp, const regi_icp_stage *last, regi_pose *poses, int count)
{
    regi_icp_stage stage = *last;
    sb_real score;
    int converged;
    for (int i = 1; i < count; i++) {
        stage.flip = poses[i].flip;
        if (!regi_icp_is_clear(poses[0].likelihood - poses[i].likelihood))
            regi_icp_iterate(icp, &stage, icp->options->max_iterations, icp->options->tolerance, &poses[i].motion,
                             &score, &converged);
    }
}

static sb_result regi_icp_run(regi_icp *icp, const reg_rigid *start, reg_icp_info *info)
{
    const reg_icp_options *options = icp->options;
    regi_pose poses[REG_ICP_POSES];
    regi_icp_stage stage;
    sb_result result;
    sb_real score;
    int converged;
    memset(&stage, 0, sizeof stage);
    stage.points = sbi_max_int(icp->a.sample.count, icp->b.sample.count);
    stage.metric = options->metric;
    stage.outliers = options->outliers;
    stage.parameter = options->outlier_parameter;
    stage.reach = options->max_distance;
    stage.flip = 1;
    result = regi_icp_begin(icp, start, &stage, poses, info);
    if (result != SB_OK)
        return result;
    regi_icp_refine_others(icp, &stage, poses, info->pose_count);
    stage.flip = poses[0].flip;
    info->iterations = regi_icp_iterate(icp, &stage, options->max_iterations, options->tolerance, &poses[0].motion,
                                        &score, &converged);
    info->stop = converged ? REG_ICP_CONVERGED : icp->out_of_time ? REG_ICP_TIME : REG_ICP_ITERATIONS;
    regi_icp_tell(icp, &poses[0].motion, info);
    if (info->pairs == 0)
        return sbi_fail(icp->error, SB_ERROR_NOT_CONVERGED, "no points of the shapes are within %g m of each other",
                        (double)options->max_distance);
    info->pose_count = regi_pose_distinct(icp, poses, info->pose_count, REG_ICP_POSES); /* the last stage moved one */
    regi_icp_tell_poses(icp, poses, info);
    result = regi_icp_report(icp, &stage, &poses[0], info);
    info->warnings = icp->warnings;
    return result;
}

REG_API sb_result reg_icp(const reg_icp_shape *model, const reg_icp_shape *target, const reg_icp_options *options,
                          reg_rigid *motion, reg_icp_info *info, sb_error *error)
{
    reg_icp_options defaults = reg_default_icp_options();
    reg_icp_info report;
    reg_rigid start;
    regi_icp icp;
    sb_result result;
    if (!model || !target || !motion)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "model, target or motion is NULL");
    memset(&icp, 0, sizeof icp);
    memset(&report, 0, sizeof report);
    icp.options = options ? options : &defaults;
    icp.allocator = &icp.options->allocator;
    icp.error = error;
    result = regi_icp_check_options(icp.options, error);
    if (result == SB_OK)
        result = regi_icp_check(model, "model", error);
    if (result == SB_OK)
        result = regi_icp_check(target, "target", error);
    if (result != SB_OK)
        return result;
    icp.begun = icp.options->clock ? icp.options->clock() : 0;
    icp.target = target;
    icp.both = icp.options->overlap == REG_ICP_WHOLE;
    icp.swapped = icp.options->overlap == REG_ICP_TARGET_PART;
    result = regi_icp_side_make(&icp, icp.swapped ? target : model, &icp.a);
    if (result == SB_OK)
        result = regi_icp_side_make(&icp, icp.swapped ? model : target, &icp.b);
    if (result == SB_OK)
        result = regi_icp_make_pairs(&icp);
    start = icp.swapped ? reg_rigid_inverse(&icp.options->start) : icp.options->start;
    if (result == SB_OK)
        result = regi_icp_run(&icp, &start, &report);
    if (result == SB_OK) {
        *motion = report.poses[0];
        if (info)
            *info = report;
    }
    sbi_free(icp.allocator, icp.pairs.from);
    sbi_free(icp.allocator, icp.pairs.weight);
    sbi_free(icp.allocator, icp.landmarks_a);
    regi_icp_side_free(icp.allocator, &icp.a);
    regi_icp_side_free(icp.allocator, &icp.b);
    return result;
}
