/* infer_private: what is inside a reg_infer. Floor 6, internal: infer_rows.c looks at the target, infer_prior.c chooses
 * the prior, infer_round.c moves the organ, infer_draws.c says how sure that is, infer.c makes it all. */
#ifndef REG_INFER_PRIVATE_H
#define REG_INFER_PRIVATE_H

#include "../softbody/solve/direct_between.h"
#include "gauss.h"
#include "infer.h"
#include "kdtree.h"
#include "look.h"
#include "marks.h"
#include "response.h"

enum {
    REGI_INFER_POSE = 6,    /* moves along the axes and turns about them; a seventh column of the pose is an offset of
                             * all points across the surface: of a scan, of a segmentation, or of facets, which bulge
                             * less than what they stand for. Without it they would be the work of a pressure */
    REGI_INFER_WEIGHT = 3,  /* columns of the weight, after those of tractions; then that of a pressure */
    REGI_INFER_REGIONS = 40 /* of unknown stiffness */
};

/* Length of the tractions, in shares of the size: about that of tools and hands. Longer ones, which evidence may well
 * prefer, need so large a scale for what is local that the organ bends by far too much where it is not seen. */
#define REGI_INFER_LENGTH 0.06

/* What the prior of the loads is like. */
typedef struct regi_infer_choice {
    double gravity;  /* sd of the weight, in shares of scale times area */
    double pressure; /* and of that on what is pressed, in shares of scale */
    double earned;   /* log evidence that it has over none */
    double misfit;   /* m */
    double scale;    /* Pa */
    double evidence; /* log */
    int is_local;    /* local[] of the inference counts */
} regi_infer_choice;

struct reg_infer {
    sb_allocator allocator;
    const reg_infer_def *def; /* during the run */
    reg_model *model;
    regi_response response; /* where the organ was before the last round */
    sbi_between *between;   /* lefts: data; rights: control points */
    regi_look look;
    regi_gauss gauss;
    regi_infer_choice choice;
    reg_quality quality;
    void *memory;
    int node_count;
    int loads;           /* 3 per control point, the weight's, and that of a pressure where there may be one */
    double begun;        /* on the clock */
    int *patch_of;       /* [count of data] patch, or -1 - line */
    double *averaged;    /* [data] m^2: the part of the variance that averages out */
    regi_marks marks;    /* landmarks and curves */
    double *raw;         /* [loads][gauss.most] responses of data, then resultants, to unit tractions and weight */
    int rooted;          /* root is of tractions alike everywhere: 1, of `local`: 2, of none of them: 0 */
    double *root;        /* [c][c] of the present prior, lower triangle */
    double *turned_root; /* [c][c] its transpose */
    double *tile;        /* [most or c, the larger][REGI_BLOCK_WIDTH] scratch */
    double *extended;    /* [most][most] gram of responses to tractions with their resultants */
    double *local, *trial_local; /* [c] */
    double *energy;              /* [c + 6] */
    double *c;                   /* [loads] found, in the gauss' units */
    double *draw;                /* [loads] */
    double *datum;               /* [most] scratch */
    double *chances;             /* [DRAWS][loads + REGI_GAUSS_POSES + most] */
    sb_vec3 *tractions;          /* [c] scratch */
    sb_vec3 *pressing;          /* [c] traction of the unit pressure where the organ is now; NULL: nothing is pressed */
    double *drift;              /* [REGI_RESPONSE_MODES][most] what modes as forces do to data, then forces that stop
                                 * their drift */
    sb_vec3 *row;               /* [REG_INFER_DRAWS][nodes] */
    sb_vec3 *skin;              /* [skin nodes] where they are (m) */
    sb_vec3 *forces;            /* [nodes] found (N) */
    sb_vec3 *increment, *trial; /* [nodes] */
    sb_vec3 *before;            /* [nodes] where they were before the last round (m) */
    sb_vec3 *shape;             /* [nodes] displacements found (m) */
    sb_vec3 *errors;            /* [DRAWS][nodes] of draws (m), calibrated */
    sb_real *expected;          /* [nodes] m */
    sb_vec3 *cell_force;        /* [cells][nodes per cell] internal forces (N) */
    sb_vec3 *poisson_force;     /* [nodes] what 0.02 of Poisson's ratio do to them (N) */
    sb_real *region;            /* [cells][REGIONS] shares */
    double pose_sd[REGI_INFER_POSE]; /* m, rad */
    double pose[REGI_INFER_POSE];    /* reached: m, rad */
    double next[REGI_GAUSS_POSES];   /* found in this round; the offset last (m) */
    sb_real spacing;                 /* m: of the patches */
    double alike;                    /* patches that count as one, >= 1 */
    double left;                     /* the same before that bound */
    double temper;                   /* share of the evidence that counts, (0, 1] */
};

/* ---- infer ---- */
/* Data that there may be. */
REGI_API int regi_infer_most_data(const reg_infer *infer);
/* Points or a surface, a camera, numbers in range. SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE (error->node). */
REGI_API sb_result regi_infer_check_points(const reg_points *target, sb_error *error);
/* 1: orthonormal, of determinant 1, finite. */
REGI_API int regi_infer_is_motion(const reg_rigid *motion);

/* ---- infer_rows ---- */
/* Seconds on the caller's clock, 0 without one. */
REGI_API double regi_infer_now(const reg_infer *infer);
/* Groups the points into patches: fills the look. SB_ERROR_MEMORY. */
REGI_API sb_result regi_infer_group(reg_infer *infer, int patches, sb_error *error);
/* Mean distance between patches that are neighbours (m). */
REGI_API sb_real regi_infer_spacing(const reg_infer *infer);
/* Looks for the points' places on the model where it is now, trusts them, and lists the data: gauss.count, patch_of,
 * averaged. Returns how many patches count. */
REGI_API int regi_infer_look(reg_infer *infer, int round);
/* Adds the row of a datum to row[nodes], and tells its gap and what the pose does to it (per m and rad). */
REGI_API void regi_infer_row(const reg_infer *infer, int datum, sb_vec3 *row, double *gap,
                             double pose[REGI_INFER_POSE]);
/* What displacements u[nodes] do to a datum (m). */
REGI_API double regi_infer_measure(const reg_infer *infer, int datum, const sb_vec3 *u);

/* ---- infer_prior ---- */
/* What a model cannot follow (m). */
REGI_API double regi_infer_least_misfit(const reg_model *model);
/* Variances of the data for a misfit (m). */
REGI_API void regi_infer_set_misfit(reg_infer *infer, double misfit);
/* Columns and resultants of the gauss for a choice. 0: none. */
REGI_API int regi_infer_set_prior(reg_infer *infer, const regi_infer_choice *choice);
/* Chooses length, weight, misfit, scale and local scale; the gauss has them. 0: it cannot. */
REGI_API int regi_infer_choose(reg_infer *infer);
/* Tractions [c] (Pa), less those of the pressure, of loads in the gauss' units. */
REGI_API void regi_infer_unfold(const reg_infer *infer, const double *c, sb_vec3 *tractions);
/* The pressure among them (Pa); 0: there is none. */
REGI_API double regi_infer_pressure(const reg_infer *infer, const double *c);
/* Forces [nodes] (N) of loads in the gauss' units. Uses `tractions`. */
REGI_API void regi_infer_load(reg_infer *infer, const double *c, sb_vec3 *forces);

/* ---- infer_respond ---- */
/* Responses, gaps and resultants of the data at hand. */
REGI_API void regi_infer_respond(reg_infer *infer);

/* ---- infer_round ---- */
REGI_API sb_result regi_infer_round(reg_infer *infer, int round, sb_error *error);
/* Moves the organ to where exact landmarks are met, by what the last round is linear about. */
REGI_API sb_result regi_infer_meet(reg_infer *infer);

/* ---- infer_draws ---- */
REGI_API sb_result regi_infer_tell(reg_infer *infer, sb_error *error);

#endif /* REG_INFER_PRIVATE_H */
