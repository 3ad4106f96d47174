/* rigid: rigid motions, and the one that brings points nearest to their partners. Floor 6. */
#ifndef REG_RIGID_H
#define REG_RIGID_H

#include "api.h"

/* x -> rotation x + translation. */
typedef struct reg_rigid {
    sb_mat3 rotation;    /* orthonormal, determinant 1 */
    sb_vec3 translation; /* m */
} reg_rigid;

REG_API reg_rigid reg_rigid_identity(void);
REG_API sb_vec3 reg_rigid_apply(const reg_rigid *motion, sb_vec3 point);
/* First `first`, then `then`. */
REG_API reg_rigid reg_rigid_compose(const reg_rigid *then, const reg_rigid *first);
REG_API reg_rigid reg_rigid_inverse(const reg_rigid *motion);
/* Angle (rad, in [0, pi]) of the rotation. */
REG_API sb_real reg_rigid_angle(const reg_rigid *motion);

/* The motion that minimises sum w |motion(from) - to|^2 (Kabsch 1976, never a reflection).
 * from, to: [count] partners (m); weights: [count] >= 0, not all 0, or NULL: all 1; count >= 1. Where the points leave
 * the rotation open (all in one line or one point) it is one of the best. SB_ERROR_ARGUMENT, _NOT_FINITE (index named)
 * leave *motion untouched. No allocation. */
REG_API sb_result reg_rigid_fit(const sb_vec3 *from, const sb_vec3 *to, const sb_real *weights, int count,
                                reg_rigid *motion, sb_error *error);

#endif /* REG_RIGID_H */
