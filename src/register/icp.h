/* icp: rigid alignment of an organ model with what is seen of it, from any pose. Floor 6.
 *
 *     reg_icp_shape model = {0}, target = {0};       (points and count; best with normals, or a surface)
 *     reg_icp_options options = reg_default_icp_options();
 *     options.overlap = REG_ICP_TARGET_PART;         (the target is a part of the model's surface)
 *     result = reg_icp(&model, &target, &options, &motion, &info, &error);     (target ~ motion(model))
 *
 * Iterative closest points (Besl, McKay 1992; to planes: Chen, Medioni 1992): pair every point with the closest one of
 * the other shape, leave out outliers, move, again. That finds the nearest minimum only, so a start is searched first:
 * many rotations, few points, few rounds; the best ones get more of both.
 *
 * The same bits for any thread and compiler; only a time limit makes a result depend on the machine. */
#ifndef REG_ICP_H
#define REG_ICP_H

#include "../softbody/geometry/surface.h"
#include "cloud.h"
#include "rigid.h"

/* One of the two shapes. Everything is borrowed during the call. Zero-initialise. Points in one place count once. */
typedef struct reg_icp_shape {
    const sb_vec3 *points; /* [count], m; also of a surface: its nodes, or samples of it */
    int count;
    const sb_vec3 *normals;    /* [count], outward, or NULL: taken from the surface, else fitted to the points */
    const sb_real *weights;    /* [count] >= 0, how much a point counts (patches that are known well); NULL: all 1 */
    const sb_real *sd;         /* [count] > 0, m, how sure a point is: counts as a weight of 1 / sd^2; NULL: alike */
    const sb_surface *surface; /* closest points are looked for on this surface; NULL: among the points */
    const reg_kdtree *tree;    /* of the points; NULL: one is made */
    int has_camera;            /* 1: this is a view, from `camera`: normals face it, and nothing is in front of it */
    sb_vec3 camera;            /* m, in this shape's frame */
} reg_icp_shape;

typedef enum reg_icp_metric {
    REG_ICP_POINT = 0, /* distance to the closest point */
    REG_ICP_PLANE = 1  /* distance to the plane through it: fewer rounds, slides along flat parts */
} reg_icp_metric;

typedef enum reg_icp_overlap {
    REG_ICP_WHOLE = 0,       /* both show the whole organ: each looks for the other */
    REG_ICP_TARGET_PART = 1, /* the target is a part of the model's surface: only its points look */
    REG_ICP_MODEL_PART = 2   /* the model is a part of the target's surface: only its points look */
} reg_icp_overlap;

/* A point of the model and where it is seen. */
typedef struct reg_icp_landmark {
    sb_vec3 model, target; /* m */
    sb_real weight;        /* > 0: as a share of all pairs of the surfaces together; 0.1: a tenth of them */
} reg_icp_landmark;

/* Start from reg_default_icp_options(). */
typedef struct reg_icp_options {
    reg_icp_overlap overlap;           /* WHOLE */
    reg_icp_metric metric;             /* PLANE */
    int search;                        /* 1: look for the start among all rotations; 0: begin at `start`; 1 */
    reg_rigid start;                   /* model to target; identity. With search it is one candidate among the others */
    sb_real start_shift_sd;            /* m, and */
    sb_real start_turn_sd;             /* rad: how sure that start is; both > 0 count in the choice; 0: not at all; 0 */
    sb_vec3 seen_from;                 /* from the organ to the camera, in the model's frame, any length; 0 */
    sb_real seen_from_sd;              /* rad, how sure that is; 0: not known; 0 */
    const reg_icp_landmark *landmarks; /* [landmark_count] or NULL */
    int landmark_count;
    reg_outliers outliers;     /* pairs that do not count, by their distance, see reg_outlier_limit; MEDIAN */
    sb_real outlier_parameter; /* 3 */
    sb_real max_distance;      /* m, > 0: pairs farther apart never count; SB_REAL_MAX */
    int sample;                /* points of a shape that look for partners, evenly spread; 0: all; 2000 */
    int max_iterations;        /* >= 1, of the last stage; 100 */
    sb_real tolerance;         /* >= 0: ends when the mean distance changes by less than this share; 1e-6 */
    sb_clock clock;            /* NULL: no time limit */
    double max_seconds;        /* > 0; 10. Looked at between rounds; what comes before them is linear in the points */
    sb_allocator allocator;    /* zeros: malloc */
    int cookie;                /* set by reg_default_icp_options */
} reg_icp_options;

typedef enum reg_icp_stop {
    REG_ICP_CONVERGED = 0,
    REG_ICP_ITERATIONS = 1, /* max_iterations */
    REG_ICP_TIME = 2        /* max_seconds */
} reg_icp_stop;

/* What to know before an alignment is used. */
typedef enum reg_warning {
    REG_WARN_AMBIGUOUS = 1, /* another pose is nearly as likely: info.poses[1] */
    /* of an inference, which has VIEW_SMALL, MANY_OUTLIERS and LOW_CONTRAST, too: */
    REG_WARN_STRAIN = 256,       /* an element has a principal stretch that differs from 1 by more than 0.3 */
    REG_WARN_VOLUME = 512,       /* the organ's volume changed by more than 0.1 */
    REG_WARN_NOT_AT_REST = 1024, /* the last round moved a node farther than the error to expect */
    REG_WARN_INVERTED = 2,       /* normals pointed inwards and were taken the other way round */
    REG_WARN_MIXED_NORMALS = 4,  /* normals pointed towards the camera and away from it: they were fitted anew */
    REG_WARN_SCALE = 8,          /* the sizes do not fit: info.scale_guess */
    REG_WARN_VIEW_SMALL = 16,    /* the target shows less than 15 % of the model */
    REG_WARN_MANY_OUTLIERS = 32, /* over 30 % of the points that looked found nothing of the other shape */
    REG_WARN_LOW_CONTRAST = 64,  /* the shapes leave a motion open, as a sphere's turns: info.covariance */
    REG_WARN_FREE_SPACE = 128    /* over 10 % of what the camera faced would hide what it saw */
} reg_warning;

enum { REG_ICP_POSES = 8 };

typedef struct reg_icp_info {
    reg_icp_stop stop;
    int iterations;       /* of the last stage */
    int candidates;       /* poses that the search tried */
    int pairs;            /* that counted at the end, without landmarks */
    sb_real overlap;      /* their share of all points that looked */
    sb_real mean, rms;    /* m, distance between the partners that counted */
    sb_real landmark_rms; /* m, weighted; 0 without landmarks */
    double seconds;       /* 0 without a clock */
    unsigned warnings;    /* REG_WARN_..., or-ed */
    /* distinct poses, model to target, the likeliest first; the first is the result, those 3 nats behind are less
     * refined */
    int pose_count;
    reg_rigid poses[REG_ICP_POSES];
    sb_real likelihood[REG_ICP_POSES]; /* nats against the first (0): for so many independent patches as the target is
                                        * large, its noise the best pose's */
    sb_real margin;                    /* nats between the first two; SB_REAL_MAX: there is one only */
    sb_real noise;                     /* m: deviation of the target from the model, noise and deformation, robust */
    sb_real seen;                      /* area of the target as a share of the model's, estimated */
    sb_real scale_guess;               /* what the target's lengths should be multiplied with; 1: nothing to say */
    /* Covariance [6][6] of the result: turn (rad) about `centre` and shift (m), in the target's frame, for independent
     * errors of the points of deviation `noise`: s^2 (A^T A)^-1 with the rows (c x n, n) of A. */
    sb_real covariance[36];
    sb_vec3 centre; /* m */
} reg_icp_info;

REG_API reg_icp_options reg_default_icp_options(void);
/* "converged", "iterations", "time"; static. */
REG_API const char *reg_icp_stop_string(reg_icp_stop stop);

/* "ambiguous", "inverted normals", ...: of one warning; static. "unknown" else. */
REG_API const char *reg_warning_string(reg_warning warning);

/* The motion that brings the model to the target.
 *
 * options  NULL: reg_default_icp_options()
 * motion   written on success, also when a cap ended the run; info (or NULL) too
 * SB_ERROR_ARGUMENT (what is said above; weights all 0), _NOT_FINITE (error->node: the point), _MEMORY,
 * _NOT_CONVERGED (no pair within max_distance): outputs untouched.
 *
 * About 0.1 s for surfaces of 6,000 points with search, 0.02 s without. Points that lie in a line, a plane or one place
 * leave motions open; it then takes one of the best. */
REG_API sb_result reg_icp(const reg_icp_shape *model, const reg_icp_shape *target, const reg_icp_options *options,
                          reg_rigid *motion, reg_icp_info *info, sb_error *error);

#endif /* REG_ICP_H */
