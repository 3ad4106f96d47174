/* infer_private: what is inside a reg_infer. Floor 6, internal: infer_rows.c looks at the target, infer_prior.c chooses
 * the prior, infer_round.c moves the organ, infer_draws.c says how sure that is, infer.c makes it all. */
#ifndef REG_INFER_PRIVATE_H
#define REG_INFER_PRIVATE_H

#include "../softbody/solve/direct_front.h"
#include "gauss.h"
#include "infer.h"
#include "kdtree.h"
#include "model_private.h"

enum {
    REGI_INFER_POSE = 6,    /* moves along the axes and turns about them; a seventh column of the pose is an offset of
                             * all points across the surface: of a scan, of a segmentation, or of facets, which bulge
                             * less than what they stand for. Without it they would be the work of a pressure */
    REGI_INFER_MODES = 6,   /* rigid motions */
    REGI_INFER_WEIGHT = 3,  /* columns of the weight */
    REGI_INFER_REGIONS = 40 /* of unknown stiffness */
};

/* What the prior of the loads is like. */
typedef struct regi_infer_choice {
    double gravity;  /* sd of the weight, in shares of scale times area */
    double misfit;   /* m */
    double scale;    /* Pa */
    double evidence; /* log */
    int is_local;    /* local[] of the inference counts */
} regi_infer_choice;

/* A point of the target and its place of the model. */
typedef struct regi_infer_point {
    sb_vec3 at, normal; /* m; unit, or 0 */
    sb_real weight;     /* trust given */
    sb_real sd;         /* m given, or 0 */
    int patch;
    /* of the last look */
    int triangle;         /* of the skin, or -1 */
    sb_real corner[3];    /* weights of its corners */
    sb_vec3 place, plane; /* m; unit normal of the model there */
    sb_real off;          /* gap less the median of its patch (m) */
    sb_real gap;          /* plane . (at - place) (m) */
    sb_real trust;        /* weight, less for outliers; 0: not allowed */
    sb_real share;        /* of its patch's row */
} regi_infer_point;

struct reg_infer {
    sb_allocator allocator;
    const reg_infer_def *def; /* during the run */
    reg_model *model;
    sb_direct *direct;
    regi_gauss gauss;
    regi_infer_choice choice;
    reg_quality quality;
    void *memory;
    int node_count, point_count, patch_count, landmark_count;
    int loads;                /* 3 per control point, then the weight's: 3 c + 3 */
    double begun;             /* on the clock */
    regi_infer_point *points; /* [point_count] by patch */
    int *patch_start;         /* [patch_count + 1] into points */
    int *patch_of;            /* [count of data] patch, or -1 - component of a landmark */
    sb_real *sort;            /* [point_count] scratch */
    sb_real noise;            /* m: of the points */
    double *averaged;         /* [data] m^2: the part of the variance that averages out */
    sb_embedding_rows marks;  /* of the landmarks in the mesh */
    sb_vec3 *mark_seen;       /* [landmark_count] m */
    sb_real *mark_sd;         /* [landmark_count] m */
    double *raw;              /* [loads][gauss.most] responses of data, then resultants, to unit tractions and weight */
    double *root;             /* [c][c] of the present prior */
    double *extended;         /* [most][most] gram of responses to tractions with their resultants */
    double *local, *trial_local; /* [c] */
    double *energy;              /* [c + 6] */
    double *c;                   /* [loads] found, in the gauss' units */
    double *draw;                /* [loads] */
    double *datum;               /* [most] scratch */
    sb_vec3 *tractions;          /* [c] scratch */
    sb_vec3 *row;                /* [SBI_FRONT_GROUP][nodes] */
    sb_vec3 *skin;               /* [skin nodes] where they are (m) */
    sb_vec3 *residual;           /* [nodes] internal forces of the shape before the last round (N) */
    sb_vec3 *forces;             /* [nodes] found (N) */
    sb_vec3 *increment, *trial;  /* [nodes] */
    sb_vec3 *shape;              /* [nodes] displacements found (m) */
    sb_vec3 *errors;             /* [DRAWS][nodes] of draws (m), calibrated */
    sb_real *expected;           /* [nodes] m */
    sb_vec3 *cell_force;         /* [cells][nodes per cell] internal forces (N) */
    sb_vec3 *poisson_force;      /* [nodes] what 0.02 of Poisson's ratio do to them (N) */
    sb_real *region;             /* [cells][REGIONS] shares */
    sb_vec3 centre;              /* m: turns of the pose are about it */
    sb_vec3 *weighted_modes;     /* [MODES][nodes] rigid motions times shares of the mass, of nothing-held organs, */
    sb_vec3 *drift;              /* [MODES][nodes] and what these as forces do */
    double drift_system[REGI_INFER_MODES * REGI_INFER_MODES]; /* their products, factored */
    double pose_sd[REGI_INFER_POSE];                          /* m, rad */
    double pose[REGI_INFER_POSE];                             /* reached: m, rad */
    double next[REGI_GAUSS_POSES];                            /* found in this round; the offset last (m) */
    double temper;                                            /* share of the evidence that counts, (0, 1] */
};

/* ---- infer_rows ---- */
/* Seconds on the caller's clock, 0 without one. */
REGI_API double regi_infer_now(const reg_infer *infer);
/* Groups the points into patches: fills points, patch_start. SB_ERROR_MEMORY. */
REGI_API sb_result regi_infer_group(reg_infer *infer, int patches, sb_error *error);
/* Looks for the points' places on the model where it is now, trusts them, and lists the data: gauss.count, patch_of,
 * averaged. Returns how many patches count. */
REGI_API int regi_infer_look(reg_infer *infer, int round);
/* Adds the row of a datum, row[nodes] zeroed, and tells its gap and what the pose does to it (per m and rad). */
REGI_API void regi_infer_row(const reg_infer *infer, int datum, sb_vec3 *row, double *gap,
                             double pose[REGI_INFER_POSE]);
/* What displacements u[nodes] do to a datum (m). */
REGI_API double regi_infer_measure(const reg_infer *infer, int datum, const sb_vec3 *u);

/* ---- infer_prior ---- */
/* Variances of the data for a misfit (m). */
REGI_API void regi_infer_set_misfit(reg_infer *infer, double misfit);
/* Columns and resultants of the gauss for a choice. 0: none. */
REGI_API int regi_infer_set_prior(reg_infer *infer, const regi_infer_choice *choice);
/* Chooses length, weight, misfit, scale and local scale; the gauss has them. 0: it cannot. */
REGI_API int regi_infer_choose(reg_infer *infer);
/* Tractions [c] (Pa) and weight (N) of loads in the gauss' units. */
REGI_API void regi_infer_unfold(const reg_infer *infer, const double *c, sb_vec3 *tractions, sb_vec3 *weight);

/* ---- infer_respond ---- */
/* Factor and residual of the shape of now. The factor's errors. */
REGI_API sb_result regi_infer_factor(reg_infer *infer, sb_error *error);
/* Motions of `count` rows of forces, row[count][nodes], in place, at most SBI_FRONT_GROUP: none of what is held, and
 * none of the whole, which is the pose's. */
REGI_API void regi_infer_solve_rows(reg_infer *infer, sb_vec3 *row, int count);
/* Responses, gaps and resultants of the data at hand. */
REGI_API void regi_infer_respond(reg_infer *infer);

/* ---- infer_round ---- */
REGI_API sb_result regi_infer_round(reg_infer *infer, int round, sb_error *error);

/* ---- infer_draws ---- */
REGI_API sb_result regi_infer_tell(reg_infer *infer, sb_error *error);

#endif /* REG_INFER_PRIVATE_H */
