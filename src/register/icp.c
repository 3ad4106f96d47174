/* icp: pairs, fits, the iteration, and the search for a start.
 *
 * Inside, one shape is `a` and looks for the other, `b`; with WHOLE both look. The motion sought is that of a onto b:
 * the model's onto the target, or with TARGET_PART its inverse. */
#include "icp.h"

enum {
    REGI_ICP_COOKIE = 0x72696370,
    REGI_ICP_FITTED = 30000, /* more points than these are thinned before normals are fitted */
    REGI_ICP_NEIGHBOURS = 10,
    REGI_ICP_FINE = 600,    /* points of a shape in the search */
    REGI_ICP_SPIRAL = 400,  /* rotations of the search, beside those that turn principal axes into each other */
    REGI_ICP_PATIENCE = 10, /* rounds without a smaller mean distance */
    REGI_ICP_STAGES = 3
};

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

/* ==== shapes ====================================================================================================== */

/* Points that look for partners. */
typedef struct regi_icp_set {
    sb_vec3 *points, *normals;
    sb_real *weights;
    int *partner; /* the last one found, which is likely to be near again: point, or triangle of the surface */
    int count;
} regi_icp_set;

/* A shape: what is found, and samples of it that look. */
typedef struct regi_icp_side {
    const sb_vec3 *points, *normals;
    const sb_real *weights;
    int count;
    const sb_surface *surface;
    const reg_kdtree *tree;
    int fitted; /* normals were fitted, and may all point the wrong way */
    reg_kdtree *own_tree;
    reg_cloud own;
    sb_real *own_weights;
    regi_icp_set sample; /* of the last stage */
    regi_icp_set spread; /* of the search: evenly spread, so that any first part of it is, too */
    reg_kdtree *spread_tree;
    sb_vec3 centre;
    sb_mat3 axes; /* columns: principal axes, turned the way the points are skewed */
    sb_real size; /* m, rms distance from the centre */
} regi_icp_side;

typedef struct regi_icp_pairs {
    sb_vec3 *from, *to, *normal;
    sb_real *weight, *distance, *scratch;
    int count;
} regi_icp_pairs;

typedef struct regi_icp {
    const reg_icp_options *options;
    const sb_allocator *allocator;
    sb_error *error;
    regi_icp_side a, b;
    int both, swapped;
    regi_icp_pairs pairs;
    sb_vec3 *landmarks_a, *landmarks_b;
    double begun;
    int out_of_time;
} regi_icp;

static void regi_icp_set_free(const sb_allocator *allocator, regi_icp_set *set)
{
    sbi_free(allocator, set->points);
    sbi_free(allocator, set->normals);
    sbi_free(allocator, set->weights);
    sbi_free(allocator, set->partner);
}

static void regi_icp_side_free(const sb_allocator *allocator, regi_icp_side *side)
{
    reg_kdtree_destroy(side->own_tree);
    reg_kdtree_destroy(side->spread_tree);
    reg_cloud_free(&side->own);
    sbi_free(allocator, side->own_weights);
    regi_icp_set_free(allocator, &side->sample);
    regi_icp_set_free(allocator, &side->spread);
}

static sb_result regi_icp_no_memory(const regi_icp *icp)
{
    return sbi_fail(icp->error, SB_ERROR_MEMORY, "no memory to align the shapes");
}

static int regi_icp_set_allocate(const sb_allocator *allocator, regi_icp_set *set, int count)
{
    set->count = count;
    set->points = (sb_vec3 *)sbi_alloc(allocator, (size_t)count, sizeof(sb_vec3));
    set->normals = (sb_vec3 *)sbi_alloc(allocator, (size_t)count, sizeof(sb_vec3));
    set->weights = (sb_real *)sbi_alloc(allocator, (size_t)count, sizeof(sb_real));
    set->partner = (int *)sbi_alloc_zeroed(allocator, (size_t)count, sizeof(int));
    return set->points && set->normals && set->weights && set->partner;
}

/* Every so-maniest point in the order of the tree, in which neighbours are neighbours: indices[wanted],
 * wanted <= count. 0 without memory. */
static int regi_icp_stride(const regi_icp *icp, const regi_icp_side *side, int wanted, int *indices)
{
    int *order = (int *)sbi_alloc(icp->allocator, (size_t)side->count, sizeof(int));
    if (!order)
        return 0;
    regi_kdtree_order(side->tree, order);
    for (int i = 0; i < wanted; i++)
        indices[i] = order[(int64_t)i * side->count / wanted];
    sbi_free(icp->allocator, order);
    return 1;
}

/* The side's points chosen[count] (NULL: the first ones) as a set. */
static sb_result regi_icp_take(const regi_icp *icp, const regi_icp_side *side, const int *chosen, int count,
                               regi_icp_set *set)
{
    if (!regi_icp_set_allocate(icp->allocator, set, count))
        return regi_icp_no_memory(icp);
    for (int i = 0; i < count; i++) {
        int at = chosen ? chosen[i] : i;
        set->points[i] = side->points[at];
        set->normals[i] = side->normals[at];
        set->weights[i] = side->weights ? side->weights[at] : 1;
    }
    return SB_OK;
}

/* The points that look in the last stage: as dense as the shape's own. */
static sb_result regi_icp_sample(const regi_icp *icp, const regi_icp_side *side, int wanted, regi_icp_set *set)
{
    int *chosen;
    sb_result result;
    if (wanted >= side->count)
        return regi_icp_take(icp, side, NULL, side->count, set);
    chosen = (int *)sbi_alloc(icp->allocator, (size_t)wanted, sizeof(int));
    result = chosen && regi_icp_stride(icp, side, wanted, chosen) ? regi_icp_take(icp, side, chosen, wanted, set)
                                                                  : regi_icp_no_memory(icp);
    sbi_free(icp->allocator, chosen);
    return result;
}

/* The points of the search, evenly spread whatever the shape's density, out of four times as many. */
static sb_result regi_icp_spread(const regi_icp *icp, const regi_icp_side *side, regi_icp_set *set)
{
    int crowd = sbi_min_int(side->count, 4 * REGI_ICP_FINE), wanted = sbi_min_int(side->count, REGI_ICP_FINE), count;
    int *indices = (int *)sbi_alloc(icp->allocator, (size_t)crowd + (size_t)wanted, sizeof(int));
    sb_vec3 *points = (sb_vec3 *)sbi_alloc(icp->allocator, (size_t)crowd, sizeof(sb_vec3));
    sb_real *scratch = (sb_real *)sbi_alloc(icp->allocator, (size_t)crowd, sizeof(sb_real));
    sb_result result;
    if (indices && points && scratch && regi_icp_stride(icp, side, crowd, indices)) {
        int *chosen = indices + crowd;
        for (int i = 0; i < crowd; i++)
            points[i] = side->points[indices[i]];
        count = reg_cloud_spread(points, crowd, wanted, chosen, scratch);
        for (int i = 0; i < count; i++)
            chosen[i] = indices[chosen[i]];
        result = regi_icp_take(icp, side, chosen, count, set);
    } else {
        result = regi_icp_no_memory(icp);
    }
    sbi_free(icp->allocator, indices);
    sbi_free(icp->allocator, points);
    sbi_free(icp->allocator, scratch);
    return result;
}

/* Where normals have to be fitted, to fewer points when there are very many. */
static sb_result regi_icp_reduce(const regi_icp *icp, regi_icp_side *side)
{
    int count = sbi_min_int(side->count, REGI_ICP_FITTED);
    int *chosen = (int *)sbi_alloc(icp->allocator, (size_t)count, sizeof(int));
    sb_result result = chosen && regi_icp_stride(icp, side, count, chosen)
                           ? regi_cloud_allocate(&side->own, count, 0, icp->allocator, icp->error)
                           : regi_icp_no_memory(icp);
    if (result == SB_OK && side->weights) {
        side->own_weights = (sb_real *)sbi_alloc(icp->allocator, (size_t)count, sizeof(sb_real));
        result = side->own_weights ? SB_OK : regi_icp_no_memory(icp);
    }
    if (result == SB_OK) {
        for (int i = 0; i < count; i++) {
            int at = count < side->count ? chosen[i] : i; /* the tree's numbers still hold */
            side->own.points[i] = side->points[at];
            if (side->weights)
                side->own_weights[i] = side->weights[at];
        }
        side->points = side->own.points;
        side->weights = side->weights ? side->own_weights : NULL;
        if (count < side->count) {
            reg_kdtree_destroy(side->own_tree);
            side->own_tree = NULL;
            side->count = count;
            result = reg_kdtree_create(side->points, count, icp->allocator, &side->own_tree, icp->error);
            side->tree = side->own_tree;
        }
    }
    sbi_free(icp->allocator, chosen);
    return result;
}

static sb_result regi_icp_normals(const regi_icp *icp, regi_icp_side *side)
{
    sb_result result;
    if (side->normals)
        return SB_OK;
    if (side->surface) {
        result = regi_cloud_allocate(&side->own, side->count, 1, icp->allocator, icp->error);
        for (int i = 0; result == SB_OK && i < side->count; i++) {
            sb_surface_hit hit;
            sb_surface_closest(side->surface, side->points[i], SB_REAL_MAX, &hit);
            side->own.normals[i] = sb_surface_normal(side->surface, &hit);
        }
    } else {
        side->fitted = 1;
        result = regi_icp_reduce(icp, side);
        if (result == SB_OK)
            result = reg_cloud_estimate_normals(&side->own, REGI_ICP_NEIGHBOURS, NULL, NULL, icp->error);
    }
    side->normals = side->own.normals;
    return result;
}

/* Centre, size and principal axes of the evenly spread points. An axis has no direction of its own: it gets the one in
 * which the points reach farther (the sign of the third moment), so that the axes turn with the shape. */
static void regi_icp_principal_axes(regi_icp_side *side)
{
    const regi_icp_set *set = &side->spread;
    sb_mat3 spread = sb_m3_zero();
    sb_vec3 skew = sb_v3(0, 0, 0), axis[3];
    side->centre = sb_v3(0, 0, 0);
    for (int i = 0; i < set->count; i++)
        side->centre = sb_v3_madd(side->centre, 1 / (sb_real)(i + 1), sb_v3_sub(set->points[i], side->centre));
    for (int i = 0; i < set->count; i++) {
        sb_vec3 d = sb_v3_sub(set->points[i], side->centre);
        spread = sb_m3_add(spread, sb_m3_outer(sb_v3_scale(1 / (sb_real)set->count, d), d));
    }
    side->size = sb_sqrt(sb_max(sb_m3_trace(spread), 0));
    sb_m3_eigen(spread, NULL, &side->axes);
    for (int i = 0; i < set->count && side->size > 0; i++) {
        sb_vec3 d = sb_m3_tapply(side->axes, sb_v3_scale(1 / side->size, sb_v3_sub(set->points[i], side->centre)));
        skew = sb_v3_add(skew, sb_v3(d.x * d.x * d.x, d.y * d.y * d.y, d.z * d.z * d.z));
    }
    axis[0] = sb_v3_scale(skew.x < 0 ? -1 : 1, sb_m3_column(side->axes, 0));
    axis[1] = sb_v3_scale(skew.y < 0 ? -1 : 1, sb_m3_column(side->axes, 1));
    axis[2] = sb_v3_cross(axis[0], axis[1]);
    side->axes = sb_m3_columns(axis[0], axis[1], axis[2]);
}

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
    if (shape->tree && reg_kdtree_count(shape->tree) != shape->count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the %s has %d points, its tree %d", which, shape->count,
                        reg_kdtree_count(shape->tree));
    return SB_OK;
}

static sb_result regi_icp_side_make(const regi_icp *icp, const reg_icp_shape *shape, regi_icp_side *side)
{
    int wanted = icp->options->sample > 0 ? icp->options->sample : shape->count;
    sb_result result = SB_OK;
    side->points = shape->points;
    side->normals = shape->normals;
    side->weights = shape->weights;
    side->count = shape->count;
    side->surface = shape->surface;
    side->tree = shape->tree;
    if (!side->tree) {
        result = reg_kdtree_create(shape->points, shape->count, icp->allocator, &side->own_tree, icp->error);
        side->tree = side->own_tree;
    }
    if (result == SB_OK)
        result = regi_icp_normals(icp, side);
    if (result == SB_OK)
        result = regi_icp_sample(icp, side, wanted, &side->sample);
    if (result == SB_OK)
        result = regi_icp_spread(icp, side, &side->spread);
    if (result == SB_OK)
        result =
            reg_kdtree_create(side->spread.points, side->spread.count, icp->allocator, &side->spread_tree, icp->error);
    if (result == SB_OK)
        regi_icp_principal_axes(side);
    return result;
}

/* ==== pairs ======================================================================================================= */

/* The point of a side closest to p within `reach`, with its normal and weight; 0 when there is none. *partner: where to
 * look first, and then what was found. */
static int regi_icp_closest(const regi_icp_side *side, int coarse, sb_vec3 p, sb_real reach, int *partner,
                            sb_vec3 *point, sb_vec3 *normal, sb_real *weight, sb_real *distance)
{
    const sb_vec3 *points = coarse ? side->spread.points : side->points;
    sb_vec3 guess;
    sb_real squared;
    int at;
    if (!coarse && side->surface) {
        sb_surface_hit hit;
        if (!sb_surface_closest_from(side->surface, p, reach, *partner, &hit))
            return 0;
        *partner = hit.triangle;
        *point = hit.point;
        *normal = sb_surface_normal(side->surface, &hit);
        *weight = 1;
        *distance = hit.distance;
        if (!side->weights)
            return 1;
        at = reg_kdtree_nearest(side->tree, hit.point, SB_REAL_MAX, NULL);
        *weight = side->weights[at];
        return 1;
    }
    guess = sb_v3_sub(points[*partner], p);
    squared = sb_v3_dot(guess, guess);
    if (!sb_is_finite(squared))
        return 0;
    at = *partner = regi_kdtree_nearest_from(coarse ? side->spread_tree : side->tree, p, *partner, &squared);
    if (sb_sqrt(squared) > reach)
        return 0;
    *point = points[at];
    *normal = coarse ? side->spread.normals[at] : side->normals[at];
    *weight = coarse ? side->spread.weights[at] : side->weights ? side->weights[at] : 1;
    *distance = sb_sqrt(squared);
    return 1;
}

/* How a stage works. */
typedef struct regi_icp_stage {
    int coarse; /* among the spread points instead of all */
    int points; /* of a set that look */
    reg_icp_metric metric;
    reg_outliers outliers;
    sb_real parameter;
    sb_real reach; /* m */
    sb_real lost;  /* m: what an outlier counts in the score; 0: no score wanted */
    int flip;      /* -1: the normals of one of the sides point the wrong way */
} regi_icp_stage;

/* Pairs of the set's points with their closest ones, appended; weights 0 where there is none, or where the normals
 * contradict. motion: of the set's side onto the other. `back`: the set is b's. Returns the sum of min(distance, lost),
 * weighted. */
static void regi_icp_look(regi_icp *icp, const regi_icp_stage *stage, const reg_rigid *motion, int back)
{
    const regi_icp_set *set =
        stage->coarse ? (back ? &icp->b.spread : &icp->a.spread) : (back ? &icp->b.sample : &icp->a.sample);
    const regi_icp_side *other = back ? &icp->a : &icp->b;
    regi_icp_pairs *pairs = &icp->pairs;
    int count = sbi_min_int(set->count, stage->points);
    for (int i = 0; i < count; i++, pairs->count++) {
        int n = pairs->count;
        sb_vec3 point, normal;
        sb_real weight = 0, distance = 0;
        pairs->weight[n] = 0;
        pairs->distance[n] = (sb_real)INFINITY;
        pairs->from[n] = pairs->to[n] = pairs->normal[n] = sb_v3(0, 0, 0);
        if (!regi_icp_closest(other, stage->coarse, reg_rigid_apply(motion, set->points[i]), stage->reach,
                              set->partner + i, &point, &normal, &weight, &distance))
            continue;
        if ((sb_real)stage->flip * sb_v3_dot(normal, sb_m3_apply(motion->rotation, set->normals[i])) < 0)
            continue;
        pairs->from[n] = back ? point : set->points[i];
        pairs->to[n] = back ? set->points[i] : point;
        pairs->normal[n] = back ? sb_m3_tapply(motion->rotation, normal) : normal;
        pairs->weight[n] = weight * set->weights[i];
        pairs->distance[n] = distance;
    }
}

/* Weights 0 for the outliers among pairs first..count. Returns the sum of min(distance, lost) of all. */
static sb_real regi_icp_prune(regi_icp_pairs *pairs, int first, const regi_icp_stage *stage)
{
    int count = pairs->count - first;
    sb_real limit =
                reg_outlier_limit(pairs->distance + first, count, stage->outliers, stage->parameter, pairs->scratch),
            sum = 0;
    for (int i = first; i < pairs->count; i++) {
        if (!(pairs->distance[i] <= limit))
            pairs->weight[i] = 0;
        sum += sb_min(pairs->distance[i], stage->lost);
    }
    return count > 0 ? sum / (sb_real)count : 0;
}

/* Pairs for this motion, and the score: the mean of min(distance, lost), landmarks included. */
static sb_real regi_icp_pair(regi_icp *icp, const regi_icp_stage *stage, const reg_rigid *motion)
{
    sb_real score, share = 1, first;
    icp->pairs.count = 0;
    regi_icp_look(icp, stage, motion, 0);
    score = regi_icp_prune(&icp->pairs, 0, stage);
    if (icp->both) {
        reg_rigid back = reg_rigid_inverse(motion);
        int forward = icp->pairs.count;
        regi_icp_look(icp, stage, &back, 1);
        first = score;
        score = (first + regi_icp_prune(&icp->pairs, forward, stage)) / 2;
    }
    for (int i = 0; i < icp->options->landmark_count; i++) {
        sb_vec3 gap = sb_v3_sub(reg_rigid_apply(motion, icp->landmarks_a[i]), icp->landmarks_b[i]);
        score += icp->options->landmarks[i].weight * sb_v3_norm(gap);
        share += icp->options->landmarks[i].weight;
    }
    return score / share;
}

/* ==== fits ======================================================================================================== */

/* Normal equations of the small motion, turn about `centre` and shift, that lowers sum w (n . (x - to))^2. */
typedef struct regi_icp_system {
    sb_real matrix[6][6], right[6]; /* lower triangle */
} regi_icp_system;

static void regi_icp_add_row(regi_icp_system *system, sb_vec3 arm, sb_vec3 normal, sb_real gap, sb_real weight)
{
    sb_vec3 turn = sb_v3_cross(arm, normal);
    sb_real row[6];
    row[0] = turn.x, row[1] = turn.y, row[2] = turn.z;
    row[3] = normal.x, row[4] = normal.y, row[5] = normal.z;
    for (int i = 0; i < 6; i++) {
        for (int j = 0; j <= i; j++)
            system->matrix[i][j] += weight * row[i] * row[j];
        system->right[i] -= weight * row[i] * gap;
    }
}

/* Cholesky, in place; the solution replaces the right-hand side. The matrix is positive definite by its damping. */
static void regi_icp_solve(regi_icp_system *system)
{
    sb_real(*m)[6] = system->matrix, *x = system->right;
    for (int i = 0; i < 6; i++)
        for (int j = 0; j <= i; j++) {
            sb_real sum = m[i][j];
            for (int k = 0; k < j; k++)
                sum -= m[i][k] * m[j][k];
            m[i][j] = i == j ? sb_sqrt(sb_max(sum, SB_EPSILON * SB_EPSILON)) : sum / m[j][j];
        }
    for (int i = 0; i < 6; i++) {
        for (int k = 0; k < i; k++)
            x[i] -= m[i][k] * x[k];
        x[i] /= m[i][i];
    }
    for (int i = 5; i >= 0; i--) {
        for (int k = i + 1; k < 6; k++)
            x[i] -= m[k][i] * x[k];
        x[i] /= m[i][i];
    }
}

/* One Gauss-Newton step to the planes. Lengths are in units of the size, so that turns and shifts are alike; a damping
 * of a millionth holds what the planes leave open. */
static void regi_icp_fit_planes(const regi_icp *icp, reg_rigid *motion)
{
    const regi_icp_pairs *pairs = &icp->pairs;
    regi_icp_system system;
    sb_real size = icp->a.size > 0 ? icp->a.size : 1, trace = 0, angle, total = 0;
    sb_vec3 centre = reg_rigid_apply(motion, icp->a.centre), shift, turn;
    reg_rigid step;
    memset(&system, 0, sizeof system);
    for (int i = 0; i < pairs->count; i++) {
        sb_vec3 x, gap;
        if (!(pairs->weight[i] > 0))
            continue;
        x = reg_rigid_apply(motion, pairs->from[i]);
        gap = sb_v3_scale(1 / size, sb_v3_sub(x, pairs->to[i]));
        total += pairs->weight[i];
        regi_icp_add_row(&system, sb_v3_scale(1 / size, sb_v3_sub(x, centre)), pairs->normal[i],
                         sb_v3_dot(pairs->normal[i], gap), pairs->weight[i]);
    }
    for (int i = 0; i < icp->options->landmark_count; i++) {
        sb_vec3 x = reg_rigid_apply(motion, icp->landmarks_a[i]);
        sb_vec3 arm = sb_v3_scale(1 / size, sb_v3_sub(x, centre));
        sb_vec3 gap = sb_v3_scale(1 / size, sb_v3_sub(x, icp->landmarks_b[i]));
        sb_real weight = total * icp->options->landmarks[i].weight;
        regi_icp_add_row(&system, arm, sb_v3(1, 0, 0), gap.x, weight);
        regi_icp_add_row(&system, arm, sb_v3(0, 1, 0), gap.y, weight);
        regi_icp_add_row(&system, arm, sb_v3(0, 0, 1), gap.z, weight);
    }
    for (int i = 0; i < 6; i++)
        trace += system.matrix[i][i];
    for (int i = 0; i < 6; i++)
        system.matrix[i][i] += (sb_real)1e-6 * trace;
    regi_icp_solve(&system);
    turn = sb_v3(system.right[0], system.right[1], system.right[2]);
    angle = sb_v3_norm(turn);
    if (angle > (sb_real)0.5) /* linearised: far turns are not to be trusted */
        turn = sb_v3_scale((sb_real)0.5 / angle, turn);
    shift = sb_v3_scale(size, sb_v3(system.right[3], system.right[4], system.right[5]));
    step.rotation = sb_quat_to_mat3(sb_quat_from_rotation_vector(turn));
    step.translation = sb_v3_add(sb_v3_sub(centre, sb_m3_apply(step.rotation, centre)), shift);
    *motion = reg_rigid_compose(&step, motion);
}

/* Kabsch's fit of the pairs and, behind them in the same arrays, the landmarks. */
static void regi_icp_fit_points(const regi_icp *icp, reg_rigid *motion)
{
    const regi_icp_pairs *pairs = &icp->pairs;
    sb_real total = 0;
    int count = pairs->count;
    for (int i = 0; i < pairs->count; i++)
        total += pairs->weight[i];
    for (int i = 0; i < icp->options->landmark_count; i++, count++) {
        pairs->from[count] = icp->landmarks_a[i];
        pairs->to[count] = icp->landmarks_b[i];
        pairs->weight[count] = total * icp->options->landmarks[i].weight;
    }
    reg_rigid_fit(pairs->from, pairs->to, pairs->weight, count, motion, NULL);
}

/* Products of many rotations drift off: back to the nearest one. */
static void regi_icp_clean(reg_rigid *motion)
{
    motion->rotation = sb_quat_to_mat3(sb_quat_from_mat3(motion->rotation));
}

/* Number and weighted mean and rms distance of the pairs that count. */
static int regi_icp_measure(const regi_icp_pairs *pairs, sb_real *mean, sb_real *rms)
{
    sb_real total = 0, sum = 0, squares = 0;
    int count = 0;
    for (int i = 0; i < pairs->count; i++) {
        sb_real w = pairs->weight[i];
        if (!(w > 0))
            continue;
        total += w;
        sum += w * pairs->distance[i];
        squares += w * pairs->distance[i] * pairs->distance[i];
        count++;
    }
    *mean = count > 0 ? sum / total : 0;
    *rms = count > 0 ? sb_sqrt(squares / total) : 0;
    return count;
}

static int regi_icp_late(regi_icp *icp)
{
    const reg_icp_options *options = icp->options;
    if (!icp->out_of_time && options->clock && options->clock() - icp->begun >= options->max_seconds)
        icp->out_of_time = 1;
    return icp->out_of_time;
}

/* At most `rounds` rounds; returns how many. The pairs are left as they are for *motion. */
static int regi_icp_iterate(regi_icp *icp, const regi_icp_stage *stage, int rounds, sb_real tolerance,
                            reg_rigid *motion, sb_real *score, int *converged)
{
    sb_real mean = 0, rms, before, best;
    int round = 0, idle = 0;
    *converged = 0;
    *score = regi_icp_pair(icp, stage, motion);
    if (regi_icp_measure(&icp->pairs, &before, &rms) == 0)
        return 0;
    for (best = before; round < rounds && !*converged; before = mean) {
        if (regi_icp_late(icp))
            break;
        if (stage->metric == REG_ICP_PLANE)
            regi_icp_fit_planes(icp, motion);
        else
            regi_icp_fit_points(icp, motion);
        regi_icp_clean(motion);
        *score = regi_icp_pair(icp, stage, motion);
        round++;
        if (regi_icp_measure(&icp->pairs, &mean, &rms) == 0)
            break;
        /* pairs may also change to and fro for ever */
        idle = mean < best * (1 - tolerance) ? 0 : idle + 1;
        best = sb_min(best, mean);
        *converged = sb_abs(mean - before) <= tolerance * before || idle == REGI_ICP_PATIENCE;
    }
    return round;
}

/* ==== search ====================================================================================================== */

typedef struct regi_icp_candidate {
    reg_rigid motion;
    sb_real score;
    int flip;
} regi_icp_candidate;

/* The i-th of n evenly spread rotations: super-Fibonacci spiral (Alexa 2022). */
static sb_mat3 regi_icp_spiral(int i, int n)
{
    const double pi2 = 6.283185307179586;
    double s = i + 0.5, r = sqrt(s / n), q = sqrt(1 - s / n);
    sb_real sa, ca, sb, cb;
    sb_sin_cos((sb_real)fmod(pi2 * s / 1.4142135623730951, pi2), &sa, &ca);
    sb_sin_cos((sb_real)fmod(pi2 * s / 1.533751168755204288, pi2), &sb, &cb);
    return sb_quat_to_mat3(
        sb_quat_normalise(sb_quat_make((sb_real)q * cb, (sb_real)r * sa, (sb_real)r * ca, (sb_real)q * sb)));
}

/* The i-th of the 24 turns of a cube onto itself; the first four keep the axes. */
static sb_mat3 regi_icp_cube(int i)
{
    static const unsigned char order[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    sb_mat3 turn = sb_m3_zero();
    int permutation = i / 4;
    for (int row = 0; row < 3; row++)
        turn.m[row][order[permutation][row]] = row < 2 ? (i >> row & 1 ? (sb_real)-1 : 1) : 1;
    if (sb_m3_det(turn) < 0)
        for (int column = 0; column < 3; column++)
            turn.m[2][column] = -turn.m[2][column];
    return turn;
}

/* Mean of the normals: where an open shape is seen from; 0 for a closed one. */
static sb_vec3 regi_icp_facing(const regi_icp_set *set)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int i = 0; i < set->count; i++)
        sum = sb_v3_add(sum, set->normals[i]);
    return sb_v3_scale(1 / (sb_real)set->count, sum);
}

/* A rotation with the translation that puts a's centre onto that of the part of b that looks a's way. */
static reg_rigid regi_icp_place(const regi_icp *icp, sb_mat3 rotation, sb_vec3 facing)
{
    const regi_icp_set *set = &icp->b.spread;
    sb_vec3 direction = sb_m3_apply(rotation, facing), seen = sb_v3(0, 0, 0);
    sb_real least = (sb_real)0.1 * sb_v3_norm(direction);
    reg_rigid motion;
    int count = 0;
    for (int i = 0; i < set->count && least > 0; i++)
        if (sb_v3_dot(set->normals[i], direction) > least)
            seen = sb_v3_madd(seen, 1 / (sb_real)++count, sb_v3_sub(set->points[i], seen));
    if (count == 0)
        seen = icp->b.centre;
    motion.rotation = rotation;
    motion.translation = sb_v3_sub(seen, sb_m3_apply(rotation, icp->a.centre));
    return motion;
}

/* Best scores first; of equal ones the earlier. */
static void regi_icp_rank(regi_icp_candidate *candidates, int count, int kept)
{
    for (int i = 0; i < kept && i < count; i++) {
        int best = i;
        regi_icp_candidate found;
        for (int j = i + 1; j < count; j++)
            best = candidates[j].score < candidates[best].score ? j : best;
        found = candidates[best];
        for (int j = best; j > i; j--)
            candidates[j] = candidates[j - 1];
        candidates[i] = found;
    }
}

/* How the search thins out its candidates. */
typedef struct regi_icp_round {
    int points, rounds, kept;
    reg_icp_metric metric;
} regi_icp_round;

static void regi_icp_add(regi_icp_candidate *candidates, int *count, reg_rigid motion, int flip)
{
    candidates[*count].motion = motion;
    candidates[*count].flip = flip;
    candidates[(*count)++].score = 0;
}

/* All poses to try, after the caller's own and that of the landmarks. */
static int regi_icp_candidates(const regi_icp *icp, const reg_rigid *start, regi_icp_candidate *candidates)
{
    const reg_icp_options *options = icp->options;
    int count = 0, spirals = icp->both ? REGI_ICP_SPIRAL / 4 : REGI_ICP_SPIRAL;
    int flips = icp->a.fitted || icp->b.fitted ? 2 : 1;
    sb_vec3 facing = icp->both ? sb_v3(0, 0, 0) : regi_icp_facing(&icp->a.spread);
    reg_rigid motion;
    for (int f = 0; f < flips; f++) {
        int flip = f ? -1 : 1;
        sb_vec3 way = sb_v3_scale((sb_real)flip, facing);
        regi_icp_add(candidates, &count, *start, flip);
        if (options->landmark_count >= 3 &&
            reg_rigid_fit(icp->landmarks_a, icp->landmarks_b, NULL, options->landmark_count, &motion, NULL) == SB_OK)
            regi_icp_add(candidates, &count, motion, flip);
        for (int i = 0; i < 24 + spirals; i++) {
            sb_mat3 turn = i < 24 ? regi_icp_cube(i) : regi_icp_spiral(i - 24, spirals);
            turn = sb_m3_mult(sb_m3_mul(icp->b.axes, turn), icp->a.axes);
            regi_icp_add(candidates, &count, regi_icp_place(icp, turn, way), flip);
        }
    }
    return count;
}

static sb_result regi_icp_search(regi_icp *icp, reg_rigid *motion, regi_icp_stage *last, int *tried)
{
    static const regi_icp_round plan[REGI_ICP_STAGES] = {
        {60, 3, 24, REG_ICP_POINT}, {250, 8, 4, REG_ICP_PLANE}, {REGI_ICP_FINE, 12, 1, REG_ICP_PLANE}};
    int most = 2 * (2 + 24 + REGI_ICP_SPIRAL), count, converged;
    regi_icp_candidate *candidates =
        (regi_icp_candidate *)sbi_alloc(icp->allocator, (size_t)most, sizeof(regi_icp_candidate));
    regi_icp_stage stage = *last;
    if (!candidates)
        return regi_icp_no_memory(icp);
    count = *tried = regi_icp_candidates(icp, motion, candidates);
    stage.coarse = 1;
    stage.outliers = REG_OUTLIERS_TRIM;
    stage.parameter = (sb_real)0.9;
    stage.reach = SB_REAL_MAX;
    stage.lost = (sb_real)0.25 * icp->a.size;
    for (int s = 0; s < REGI_ICP_STAGES; s++) {
        stage.points = plan[s].points;
        stage.metric = plan[s].metric;
        for (int i = 0; i < count; i++) {
            stage.flip = candidates[i].flip;
            regi_icp_iterate(icp, &stage, plan[s].rounds, 0, &candidates[i].motion, &candidates[i].score, &converged);
            if (icp->out_of_time) {
                *tried = s == 0 ? i + 1 : *tried;
                count = i + 1;
            }
        }
        regi_icp_rank(candidates, count, plan[s].kept);
        count = sbi_min_int(count, plan[s].kept);
    }
    *motion = candidates[0].motion;
    last->flip = candidates[0].flip;
    sbi_free(icp->allocator, candidates);
    return SB_OK;
}

/* ==== the call ==================================================================================================== */

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
    if (reg_outlier_limit(&one, 1, o->outliers, o->outlier_parameter, &scratch) < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "outlier rule %d with the parameter %g is out of range",
                        (int)o->outliers, (double)o->outlier_parameter);
    return regi_icp_check_landmarks(o, error);
}

static sb_result regi_icp_make_pairs(regi_icp *icp)
{
    int landmarks = icp->options->landmark_count;
    int points = sbi_max_int(icp->a.sample.count, icp->a.spread.count);
    int most = points + (icp->both ? sbi_max_int(icp->b.sample.count, icp->b.spread.count) : 0);
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

static sb_result regi_icp_run(regi_icp *icp, reg_rigid *motion, reg_icp_info *info)
{
    const reg_icp_options *options = icp->options;
    regi_icp_stage stage;
    sb_result result = SB_OK;
    sb_real score;
    int converged;
    memset(&stage, 0, sizeof stage);
    stage.points = sbi_max_int(icp->a.sample.count, icp->b.sample.count);
    stage.metric = options->metric;
    stage.outliers = options->outliers;
    stage.parameter = options->outlier_parameter;
    stage.reach = options->max_distance;
    stage.flip = 1;
    if (options->search)
        result = regi_icp_search(icp, motion, &stage, &info->candidates);
    else if (icp->a.fitted || icp->b.fitted)
        stage.flip = regi_icp_find_flip(icp, &stage, motion);
    if (result != SB_OK)
        return result;
    info->iterations =
        regi_icp_iterate(icp, &stage, options->max_iterations, options->tolerance, motion, &score, &converged);
    info->stop = converged ? REG_ICP_CONVERGED : icp->out_of_time ? REG_ICP_TIME : REG_ICP_ITERATIONS;
    regi_icp_tell(icp, motion, info);
    if (info->pairs == 0)
        return sbi_fail(icp->error, SB_ERROR_NOT_CONVERGED, "no points of the shapes are within %g m of each other",
                        (double)options->max_distance);
    return SB_OK;
}

REG_API sb_result reg_icp(const reg_icp_shape *model, const reg_icp_shape *target, const reg_icp_options *options,
                          reg_rigid *motion, reg_icp_info *info, sb_error *error)
{
    reg_icp_options defaults = reg_default_icp_options();
    reg_icp_info report;
    reg_rigid found;
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
    icp.both = icp.options->overlap == REG_ICP_WHOLE;
    icp.swapped = icp.options->overlap == REG_ICP_TARGET_PART;
    result = regi_icp_side_make(&icp, icp.swapped ? target : model, &icp.a);
    if (result == SB_OK)
        result = regi_icp_side_make(&icp, icp.swapped ? model : target, &icp.b);
    if (result == SB_OK)
        result = regi_icp_make_pairs(&icp);
    found = icp.swapped ? reg_rigid_inverse(&icp.options->start) : icp.options->start;
    if (result == SB_OK)
        result = regi_icp_run(&icp, &found, &report);
    if (result == SB_OK) {
        *motion = icp.swapped ? reg_rigid_inverse(&found) : found;
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
