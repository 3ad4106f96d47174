/* icp_report: how far an alignment can be trusted. */
#include "icp_private.h"

/* 1.48 times the median distance from the planes of the pairs that count, and what fitting six numbers took off it. */
static sb_real regi_report_noise(regi_icp *icp, const reg_rigid *motion)
{
    regi_icp_pairs *pairs = &icp->pairs;
    sb_real least = 64 * SB_EPSILON * (icp->a.extent + icp->b.extent), limit;
    int count = 0;
    for (int i = 0; i < pairs->count; i++)
        if (pairs->weight[i] > 0) {
            sb_vec3 way = sb_v3_sub(reg_rigid_apply(motion, pairs->from[i]), pairs->to[i]);
            pairs->distance[count++] = sb_abs(sb_v3_dot(way, pairs->normal[i]));
        }
    limit = reg_outlier_limit(pairs->distance, count, REG_OUTLIERS_TRIM, (sb_real)0.5, pairs->scratch);
    limit *= sb_sqrt((sb_real)count / (sb_real)sbi_max_int(count - 6, 1));
    return sb_max((sb_real)1.4826 * limit, least);
}

/* Inverse of the information, about a's moved centre in b's frame. Before anything is seen a turn is known to 1.8 rad
 * (any is as likely), a shift to the shapes' extent, or as well as the start. */
static void regi_report_invert(const regi_icp *icp, const regi_icp_system *seen, sb_real noise,
                               sb_real covariance[6][6])
{
    const reg_icp_options *o = icp->options;
    sb_real size = icp->a.size > 0 ? icp->a.size : 1, turn = (sb_real)1.8, shift = icp->a.extent + icp->b.extent;
    regi_icp_system prior = *seen;
    if (o->start_shift_sd > 0 && o->start_turn_sd > 0) {
        turn = sb_min(turn, o->start_turn_sd);
        shift = sb_min(shift, o->start_shift_sd);
    }
    turn = noise / (size * turn);
    shift = shift > 0 ? noise / shift : 1;
    for (int i = 0; i < 6; i++)
        prior.matrix[i][i] += i < 3 ? turn * turn : shift * shift;
    for (int j = 0; j < 6; j++) {
        regi_icp_system unit = prior;
        memset(unit.right, 0, sizeof unit.right);
        unit.right[j] = 1;
        regi_icp_solve(&unit);
        for (int i = 0; i < 6; i++)
            covariance[i][j] = (i < 3 ? noise / size : noise) * (j < 3 ? noise / size : noise) * unit.right[i];
    }
}

static sb_mat3 regi_report_block(sb_real covariance[6][6], int row, int column)
{
    sb_mat3 block;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            block.m[i][j] = covariance[row + i][column + j];
    return block;
}

/* Of the model's motion, in the target's frame. With the shapes exchanged it is the motion back, by -R^T. */
static void regi_report_covariance(const regi_icp *icp, const reg_rigid *motion, reg_icp_info *info)
{
    regi_icp_system system;
    sb_real covariance[6][6];
    regi_icp_equations(icp, motion, 1, &system);
    regi_report_invert(icp, &system, info->noise, covariance);
    info->centre = icp->swapped ? icp->a.centre : reg_rigid_apply(motion, icp->a.centre);
    for (int row = 0; row < 6; row += 3)
        for (int column = 0; column < 6; column += 3) {
            sb_mat3 block = regi_report_block(covariance, row, column);
            if (icp->swapped)
                block = sb_m3_mul(sb_m3_tmul(motion->rotation, block), motion->rotation);
            for (int i = 0; i < 9; i++)
                info->covariance[(row + i / 3) * 6 + column + i % 3] = block.m[i / 3][i % 3];
        }
}

/* Largest deviation along any direction, of the turn (first 0) or the shift (first 3). */
static sb_real regi_report_largest(const reg_icp_info *info, int first)
{
    sb_mat3 block;
    sb_vec3 values;
    for (int i = 0; i < 9; i++)
        block.m[i / 3][i % 3] = info->covariance[(first + i / 3) * 6 + first + i % 3];
    sb_m3_eigen(block, &values, NULL);
    return sb_sqrt(sb_max(values.x, 0));
}

/* Median distance of the spread points from their centre. */
static sb_real regi_report_radius(regi_icp *icp, const regi_icp_side *side)
{
    regi_icp_pairs *pairs = &icp->pairs;
    for (int i = 0; i < side->spread.count; i++)
        pairs->distance[i] = sb_v3_norm(sb_v3_sub(side->spread.points[i], side->centre));
    return reg_outlier_limit(pairs->distance, side->spread.count, REG_OUTLIERS_TRIM, (sb_real)0.5, pairs->scratch);
}

/* The units that may have been mistaken for each other, or the ratio itself. */
static sb_real regi_report_guess(sb_real ratio)
{
    static const double units[] = {1000, 1e-3, 25.4, 1 / 25.4, 100, 0.01, 10, 0.1, 39.37, 1 / 39.37};
    double best = (double)ratio, least = log(2.5);
    for (int i = 0; i < (int)(sizeof units / sizeof units[0]); i++) {
        double off = fabs(log((double)ratio / units[i]));
        if (off < least) {
            least = off;
            best = units[i];
        }
    }
    return (sb_real)best;
}

/* The shapes' sizes: of the whole organ they agree, a part is no larger than the whole, nor a speck of it. */
static void regi_report_scale(regi_icp *icp, reg_icp_info *info)
{
    sb_real a = regi_report_radius(icp, &icp->a), b = regi_report_radius(icp, &icp->b), ratio, model;
    info->scale_guess = 1;
    if (!(a > 0) || !(b > 0))
        return;
    ratio = a / b; /* a is the part, where there is one, and as a rule three quarters as large */
    model = icp->swapped ? 1 / ratio : ratio;
    if (icp->both ? ratio < (sb_real)1.5 && ratio > 1 / (sb_real)1.5 : ratio < (sb_real)1.5 && ratio > (sb_real)0.05)
        return;
    icp->warnings |= REG_WARN_SCALE;
    if (!icp->both)
        model *= icp->swapped ? (sb_real)0.75 : 1 / (sb_real)0.75;
    info->scale_guess = regi_report_guess(model);
}

REGI_API sb_result regi_icp_report(regi_icp *icp, const regi_icp_stage *stage, const regi_pose *best,
                                   reg_icp_info *info)
{
    const regi_icp_side *model = icp->swapped ? &icp->b : &icp->a, *target = icp->swapped ? &icp->a : &icp->b;
    regi_pose pose = *best;
    sb_real dependent, model_size = sb_max(model->extent, target->extent);
    sb_result result;
    info->noise = regi_report_noise(icp, &pose.motion);
    regi_report_covariance(icp, &pose.motion, info);
    result = regi_pose_rank(icp, stage, &pose, 1);
    if (result != SB_OK)
        return result;
    dependent = sb_sqrt(sb_max(1, (sb_real)info->pairs / regi_pose_points(icp, pose.correlation)));
    if (dependent * regi_report_largest(info, 0) > (sb_real)0.087 ||
        dependent * regi_report_largest(info, 3) > (sb_real)0.02 * model_size)
        icp->warnings |= REG_WARN_LOW_CONTRAST;
    info->seen = model->area > 0 ? sb_min(target->area / model->area, 1) : 1;
    if (icp->swapped && info->seen < (sb_real)0.15)
        icp->warnings |= REG_WARN_VIEW_SMALL;
    if (pose.lost > (sb_real)0.3)
        icp->warnings |= REG_WARN_MANY_OUTLIERS;
    if (pose.in_front > (sb_real)0.1)
        icp->warnings |= REG_WARN_FREE_SPACE;
    regi_report_scale(icp, info);
    return SB_OK;
}
