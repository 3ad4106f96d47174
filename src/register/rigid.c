/* rigid: motions and Kabsch's fit. */
#include "rigid.h"

REG_API reg_rigid reg_rigid_identity(void)
{
    reg_rigid motion;
    motion.rotation = sb_m3_identity();
    motion.translation = sb_v3(0, 0, 0);
    return motion;
}

REG_API sb_vec3 reg_rigid_apply(const reg_rigid *motion, sb_vec3 point)
{
    if (!motion)
        return sb_v3(0, 0, 0);
    return sb_v3_add(sb_m3_apply(motion->rotation, point), motion->translation);
}

REG_API reg_rigid reg_rigid_compose(const reg_rigid *then, const reg_rigid *first)
{
    reg_rigid none;
    reg_rigid motion;
    if (!then || !first) {
        memset(&none, 0, sizeof none);
        return none;
    }
    motion.rotation = sb_m3_mul(then->rotation, first->rotation);
    motion.translation = reg_rigid_apply(then, first->translation);
    return motion;
}

REG_API reg_rigid reg_rigid_inverse(const reg_rigid *motion)
{
    reg_rigid none;
    reg_rigid inverse;
    if (!motion) {
        memset(&none, 0, sizeof none);
        return none;
    }
    inverse.rotation = sb_m3_transpose(motion->rotation);
    inverse.translation = sb_v3_scale(-1, sb_m3_apply(inverse.rotation, motion->translation));
    return inverse;
}

/* The axis times 2 sin, and 1 + 2 cos: together they determine small angles and angles near pi alike. */
REG_API sb_real reg_rigid_angle(const reg_rigid *motion)
{
    const sb_mat3 *r = motion ? &motion->rotation : NULL;
    sb_vec3 axis;
    if (!r)
        return 0;
    axis = sb_v3(r->m[2][1] - r->m[1][2], r->m[0][2] - r->m[2][0], r->m[1][0] - r->m[0][1]);
    return sb_atan2(sb_v3_norm(axis), r->m[0][0] + r->m[1][1] + r->m[2][2] - 1);
}

static sb_result regi_rigid_check(const sb_vec3 *from, const sb_vec3 *to, const sb_real *weights, int count,
                                  sb_error *error)
{
    sb_real largest = 0;
    if (!from || !to || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a fit needs at least one pair of points, not %d", count);
    for (int i = 0; i < count; i++) {
        sb_real w = weights ? weights[i] : 1;
        if (!sb_v3_is_finite(from[i]) || !sb_v3_is_finite(to[i]) || !sb_is_finite(w))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "pair %d is not finite", i);
        if (w < 0)
            return sbi_fail(error, SB_ERROR_ARGUMENT, "the weight of pair %d is %g, not 0 or more", i, (double)w);
        largest = w > largest ? w : largest;
    }
    if (!(largest > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "all weights are 0");
    return SB_OK;
}

REG_API sb_result reg_rigid_fit(const sb_vec3 *from, const sb_vec3 *to, const sb_real *weights, int count,
                                reg_rigid *motion, sb_error *error)
{
    sb_result result = motion ? regi_rigid_check(from, to, weights, count, error)
                              : sbi_fail(error, SB_ERROR_ARGUMENT, "reg_rigid_fit needs a place for the motion");
    sb_vec3 mean_from = sb_v3(0, 0, 0), mean_to = mean_from, stretches;
    sb_mat3 spread = sb_m3_zero(), u, v;
    sb_real total = 0;
    if (result != SB_OK)
        return result;
    for (int i = 0; i < count; i++) {
        sb_real w = weights ? weights[i] : 1;
        if (!(w > 0))
            continue;
        total += w;
        mean_from = sb_v3_madd(mean_from, w / total, sb_v3_sub(from[i], mean_from));
        mean_to = sb_v3_madd(mean_to, w / total, sb_v3_sub(to[i], mean_to));
    }
    for (int i = 0; i < count; i++) {
        sb_vec3 a = sb_v3_scale((weights ? weights[i] : 1) / total, sb_v3_sub(to[i], mean_to));
        spread = sb_m3_add(spread, sb_m3_outer(a, sb_v3_sub(from[i], mean_from)));
    }
    /* u and v of this factorisation are rotations, the sign of the determinant is in the last stretch: u v^T is the
     * nearest rotation. */
    sb_m3_svd(spread, &u, &stretches, &v);
    motion->rotation = sb_m3_mul(u, sb_m3_transpose(v));
    motion->translation = sb_v3_sub(mean_to, sb_m3_apply(motion->rotation, mean_from));
    return SB_OK;
}
