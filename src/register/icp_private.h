/* icp_private: what is inside a reg_icp. Floor 6, internal: icp_side.c makes the shapes, icp_step.c pairs and moves
 * them, pose.c searches and weighs poses, icp.c is the call.
 *
 * One shape is `a` and looks for the other, `b`; with WHOLE both look. The motion sought is that of a onto b: the
 * model's onto the target, or with TARGET_PART its inverse. */
#ifndef REG_ICP_PRIVATE_H
#define REG_ICP_PRIVATE_H

#include "icp.h"

enum { REGI_ICP_FINE = 600 }; /* points of a shape in the search */

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
    const sb_real *weights, *sd;
    sb_real usual_sd; /* m, the median; 1 without sd */
    int count;
    const sb_surface *surface;
    const reg_kdtree *tree;
    int sign;    /* -1: its normals point inwards, and count turned */
    int unsure;  /* which way the normals point is not known: both ways are tried */
    int fitted;  /* its normals are fitted */
    int cleaned; /* isolated points are out already */
    int closed;  /* a closed surface */
    reg_kdtree *own_tree;
    reg_cloud own;
    sb_real *own_weights; /* from weights and sd */
    regi_icp_set sample;  /* of the last stage */
    regi_icp_set spread;  /* of the search: evenly spread, so that any first part of it is, too */
    reg_kdtree *spread_tree;
    sb_vec3 centre;
    sb_mat3 axes;    /* columns: principal axes, turned the way the points are skewed */
    sb_real size;    /* m, rms distance from the centre */
    sb_real extent;  /* m, diagonal of the spread points' box */
    sb_real area;    /* m^2, estimated */
    sb_real spacing; /* m, between its points */
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
    const reg_icp_shape *target;
    unsigned warnings;
    double begun;
    int out_of_time;
} regi_icp;

/* How a stage works. */
typedef struct regi_icp_stage {
    int spread; /* the evenly spread points look instead of the sample */
    int coarse; /* and are looked at instead of all; needs `spread` */
    int points; /* of a set that look */
    reg_icp_metric metric;
    reg_outliers outliers;
    sb_real parameter;
    sb_real reach; /* m */
    sb_real lost;  /* m: what an outlier counts in the score; 0: no score wanted */
    int flip;      /* -1: the normals of one of the sides point the wrong way */
} regi_icp_stage;

/* A pose: motion of a onto b. */
typedef struct regi_pose {
    reg_rigid motion;
    sb_real score;       /* m, of the search */
    sb_real likelihood;  /* nats, tempered */
    sb_real noise;       /* m, robust, of the gaps */
    sb_real lost;        /* share of points that find nothing within 6 noise */
    sb_real correlation; /* of neighbouring gaps, in [0, 1] */
    sb_real in_front;    /* share of the model that would hide what the camera saw */
    int flip;
} regi_pose;

/* Normal equations of the small motion, turn about a's moved centre and shift, that lowers sum w (n . (x - to))^2.
 * Lengths are in units of a's size, so that turns and shifts are alike. */
typedef struct regi_icp_system {
    sb_real matrix[6][6], right[6]; /* lower triangle */
} regi_icp_system;

/* ---- icp_side.c ---- */
REGI_API sb_result regi_icp_no_memory(const regi_icp *icp);
REGI_API sb_result regi_icp_side_make(regi_icp *icp, const reg_icp_shape *shape, regi_icp_side *side);
/* What a point of the side counts, by its weight and its sd. */
REGI_API sb_real regi_icp_weight(const regi_icp_side *side, int point);
REGI_API void regi_icp_side_free(const sb_allocator *allocator, regi_icp_side *side);
/* Mean of the normals: where an open shape is seen from; 0 for a closed one. */
REGI_API sb_vec3 regi_icp_facing(const regi_icp_set *set);

/* The motion of the model onto the target. */
REGI_API reg_rigid regi_icp_of_model(const regi_icp *icp, const reg_rigid *motion);

/* ---- icp_step.c ---- */
/* Pairs for this motion, and the score: the mean of min(distance, lost), landmarks included. */
REGI_API sb_real regi_icp_pair(regi_icp *icp, const regi_icp_stage *stage, const reg_rigid *motion);
/* Number and weighted mean and rms distance of the pairs that count. */
REGI_API int regi_icp_measure(const regi_icp_pairs *pairs, sb_real *mean, sb_real *rms);
/* At most `rounds` rounds; returns how many. The pairs are left as they are for *motion. */
REGI_API int regi_icp_iterate(regi_icp *icp, const regi_icp_stage *stage, int rounds, sb_real tolerance,
                              reg_rigid *motion, sb_real *score, int *converged);

/* Of the pairs and the landmarks. at_planes: arms reach to the partners and not to the points: how points lie beside
 * their partners then tells no turn. */
REGI_API void regi_icp_equations(const regi_icp *icp, const reg_rigid *motion, int at_planes, regi_icp_system *system);
/* Cholesky, in place; the solution replaces the right-hand side. The matrix has to be positive definite, by damping. */
REGI_API void regi_icp_solve(regi_icp_system *system);

/* ---- pose_view.c ---- */
/* Log-likelihood of a pose by what the caller knows; angles may be off by `slack` (rad) for nothing, and shifts then
 * do not count. */
REGI_API sb_real regi_pose_prior(const regi_icp *icp, const regi_pose *pose, sb_real slack);
/* Share of the model, of what is inside the camera's view of the target, that would be nearer to the camera than what
 * it saw by 2 % of the model's size; 0 without a camera. */
REGI_API sb_real regi_pose_in_front(const regi_icp *icp, const reg_rigid *motion);

/* ---- pose.c ---- */
/* As many independent points as what looks is worth: patches of a tenth of the model's size in radius, as far as the
 * points' gaps are correlated. */
REGI_API sb_real regi_pose_points(const regi_icp *icp, sb_real correlation);
/* Fills the poses' likelihoods and what they come from, and sorts them by it. Overwrites the pairs. */
REGI_API sb_result regi_pose_rank(regi_icp *icp, const regi_icp_stage *last, regi_pose *poses, int count);
/* Of poses, the best first, those that differ from all before them, by 8 degrees or, in the mean over the model, by 5 %
 * of its size; up to `kept`. Returns how many. */
REGI_API int regi_pose_distinct(const regi_icp *icp, regi_pose *poses, int count, int kept);
/* Finds poses[REG_ICP_POSES], the likeliest first: *count >= 1; *tried: how many were begun with. */
REGI_API sb_result regi_pose_search(regi_icp *icp, const reg_rigid *start, const regi_icp_stage *last, regi_pose *poses,
                                    int *count, int *tried);

/* ---- icp_report.c ---- */
/* Noise, covariance, and warnings of the result, of which the pairs are the last. Overwrites them. */
REGI_API sb_result regi_icp_report(regi_icp *icp, const regi_icp_stage *stage, const regi_pose *best,
                                   reg_icp_info *info);

#endif /* REG_ICP_PRIVATE_H */
