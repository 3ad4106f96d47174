/* steer_path: poses, helices, and how near paths come to obstacles, in double. Floor 6, internal: the planner's and the
 * controller's. */
#ifndef NDL_STEER_PATH_H
#define NDL_STEER_PATH_H

#include "real3.h"
#include "steer.h"

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
typedef struct ndli_pose {
    ndli_v3 p, m1, m2, t;
} ndli_pose;

/* The end of a helix from a pose at the origin with axes x, y, z, and its derivatives: d/ds is the tangent. */
typedef struct ndli_helix_end {
    ndli_v3 p, ds, dw;
} ndli_helix_end;

/* Obstacles and the distance that paths keep from them. */
typedef struct ndli_field {
    const ndl_obstacle *obstacles;
    int count;
    double clearance;
    double resolution; /* m: least step along a path; between two of them it may be resolution/2 nearer */
} ndli_field;

/* SB_ERROR_NOT_FINITE, or SB_ERROR_ARGUMENT for a frame that is none. */
NDLI_API sb_result ndli_pose_read(const ndl_tip_pose *tip, ndli_pose *pose);
NDLI_API ndl_tip_pose ndli_pose_write(const ndli_pose *pose);
NDLI_API ndli_pose ndli_pose_turn(const ndli_pose *pose, double angle);
NDLI_API ndli_pose ndli_pose_helix(const ndli_pose *pose, double k, double w, double s);
NDLI_API ndli_v3 ndli_pose_out(const ndli_pose *pose, ndli_v3 local); /* world point of a local one */
NDLI_API ndli_v3 ndli_pose_in(const ndli_pose *pose, ndli_v3 point);  /* local point of a world one */
NDLI_API ndli_v3 ndli_helix_point(double k, double w, double s);      /* local */
NDLI_API ndli_helix_end ndli_helix_derive(double k, double w, double s);

NDLI_API double ndli_field_distance(const ndli_field *field, ndli_v3 p); /* DBL_MAX without obstacles */
/* Follows a helix until an obstacle is nearer than clearance - slack s^3: the length that is free, at most `length`.
 * *nearest is lowered to what the distance along that length proves to be. */
NDLI_API double ndli_field_march(const ndli_field *field, const ndli_pose *pose, double k, double w, double length,
                                 double slack, double *nearest);

/* ---- the planner's, for the controller ---- */
NDLI_API sb_result ndli_obstacle_check(const ndl_obstacle *o, int i, sb_error *error); /* i: its name in messages */
NDLI_API sb_result ndli_plan_check(const ndl_plan_def *def, sb_error *error);
/* The plan whose pieces aim at the waypoints in turn, then at the target, with the curvature, limits and tolerance of
 * def; `sense` is the sign of twist to keep, or 0. Where it meets an obstacle nearer than `clearance` it is cut off
 * there. Returns whether it is clear. */
NDLI_API int ndli_plan_aim(const ndl_plan_def *def, double clearance, const ndli_pose *pose, const sb_vec3 *waypoints,
                           int waypoint_count, ndli_v3 target, double sense, ndl_plan *plan);
NDLI_API void ndli_plan_search(const ndl_plan_def *def, const ndli_pose *pose, ndli_v3 target, double sense,
                               ndl_plan *plan);
#endif

#endif /* NDL_STEER_PATH_H */
