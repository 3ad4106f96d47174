/* steer_push: what the planner of pushes needs of the controller's. Floor 6, internal. */
#ifndef NDL_STEER_PUSH_H
#define NDL_STEER_PUSH_H

#include "real3.h"
#include "steer.h"

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* The same def, its directions made unit vectors. */
NDLI_API ndl_push_def ndli_push_unit(const ndl_push_def *def);
/* The way that a point has still to go, across the path: onto it, or out of the cylinder about it. */
NDLI_API ndli_v3 ndli_push_error(const ndl_push_def *unit, ndli_v3 point);
/* The force that the def allows which comes nearest to displacing a point of this compliance by `wanted` across the
 * path; returns what that leaves (m). */
NDLI_API double ndli_push_try(const ndl_push_def *unit, const sb_mat3 *compliance, ndli_v3 wanted, ndli_v3 *force);
#endif

#endif /* NDL_STEER_PUSH_H */
