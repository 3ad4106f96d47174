/* icp_step: pairs, fits and the iteration. */
#include "icp_private.h"

enum { REGI_ICP_PATIENCE = 10 }; /* rounds without a smaller mean distance */

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
        *normal = sb_v3_scale((sb_real)side->sign, sb_surface_normal(side->surface, &hit));
        *weight = 1;
        *distance = hit.distance;
        if (!side->weights && !side->sd)
            return 1;
        at = reg_kdtree_nearest(side->tree, hit.point, SB_REAL_MAX, NULL);
        *weight = regi_icp_weight(side, at);
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
    *normal = coarse ? side->spread.normals[at] : sb_v3_scale((sb_real)side->sign, side->normals[at]);
    *weight = coarse ? side->spread.weights[at] : regi_icp_weight(side, at);
    *distance = sb_sqrt(squared);
    return 1;
}

/* Pairs of the set's points with their closest ones, appended; weights 0 where there is none, or where the normals
 * contradict. motion: of the set's side onto the other. `back`: the set is b's. Returns the sum of min(distance, lost),
 * weighted. */
static void regi_icp_look(regi_icp *icp, const regi_icp_stage *stage, const reg_rigid *motion, int back)
{
    const regi_icp_set *set =
        stage->spread ? (back ? &icp->b.spread : &icp->a.spread) : (back ? &icp->b.sample : &icp->a.sample);
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

REGI_API sb_real regi_icp_pair(regi_icp *icp, const regi_icp_stage *stage, const reg_rigid *motion)
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

REGI_API void regi_icp_solve(regi_icp_system *system)
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

REGI_API void regi_icp_equations(const regi_icp *icp, const reg_rigid *motion, int at_planes, regi_icp_system *system)
{
    const regi_icp_pairs *pairs = &icp->pairs;
    sb_real size = icp->a.size > 0 ? icp->a.size : 1, total = 0;
    sb_vec3 centre = reg_rigid_apply(motion, icp->a.centre);
    memset(system, 0, sizeof *system);
    for (int i = 0; i < pairs->count; i++) {
        sb_vec3 x, gap;
        if (!(pairs->weight[i] > 0))
            continue;
        x = reg_rigid_apply(motion, pairs->from[i]);
        gap = sb_v3_scale(1 / size, sb_v3_sub(x, pairs->to[i]));
        total += pairs->weight[i];
        regi_icp_add_row(system, sb_v3_scale(1 / size, sb_v3_sub(at_planes ? pairs->to[i] : x, centre)),
                         pairs->normal[i], sb_v3_dot(pairs->normal[i], gap), pairs->weight[i]);
    }
    for (int i = 0; i < icp->options->landmark_count; i++) {
        sb_vec3 x = reg_rigid_apply(motion, icp->landmarks_a[i]);
        sb_vec3 arm = sb_v3_scale(1 / size, sb_v3_sub(x, centre));
        sb_vec3 gap = sb_v3_scale(1 / size, sb_v3_sub(x, icp->landmarks_b[i]));
        sb_real weight = total * icp->options->landmarks[i].weight;
        regi_icp_add_row(system, arm, sb_v3(1, 0, 0), gap.x, weight);
        regi_icp_add_row(system, arm, sb_v3(0, 1, 0), gap.y, weight);
        regi_icp_add_row(system, arm, sb_v3(0, 0, 1), gap.z, weight);
    }
}

/* One Gauss-Newton step to the planes; a damping of a millionth holds what they leave open. */
static void regi_icp_fit_planes(const regi_icp *icp, reg_rigid *motion)
{
    regi_icp_system system;
    sb_real size = icp->a.size > 0 ? icp->a.size : 1, trace = 0, angle;
    sb_vec3 centre = reg_rigid_apply(motion, icp->a.centre), shift, turn;
    reg_rigid step;
    regi_icp_equations(icp, motion, 0, &system);
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

REGI_API int regi_icp_measure(const regi_icp_pairs *pairs, sb_real *mean, sb_real *rms)
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

REGI_API int regi_icp_iterate(regi_icp *icp, const regi_icp_stage *stage, int rounds, sb_real tolerance,
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
