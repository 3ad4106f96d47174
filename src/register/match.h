/* match: physics-based shape matching: an elastic organ whose charged surface is drawn onto a target. Floor 6.
 *
 * The organ is a body of any mesh and material (corotated; linear is the thesis' other variant). Its surface carries
 * charges, one in each triangle or at each vertex, held by the element they lie in. The surface may be the model's own
 * skin or, better, the fine surface that the coarse model was made from: then that surface is matched, not the coarse
 * model's facets. In the potential phi of the target (see field.h) a charge q A feels the force -q A grad phi, whose
 * stiffness along its line of action is taken into the system:
 *     (K + K_phi) du = -(f_int + f_phi),     f_phi = q A N_I phi' m,    K_phi = q A N_I N_J phi'' m m^T
 * One step solves this once and then raises the charge by the ratio of elastic to electric energy, held within bounds:
 * q grows from a gentle pull, by which the organ finds its way, to a firm one, by which it fits. Steps at full charge
 * are relaxed (Aitken), or charges that rest on edges between the target's facets would swing to and fro for ever.
 *
 * Steps are quasi-static. K_phi and the slow growth of the charge give the stability that the thesis gets from Newmark
 * dynamics: with its stiffness damping the same number of steps led to the same end.
 *
 * What it cannot know: a surface that slides along itself keeps its shape. What loads normal to the surface did comes
 * out to a few hundredths of the motion or much better, from a part of the surface too; but where the organ was dragged
 * along its surface the motion found is the one of least energy, which may be off by the length of the drag. Landmarks
 * mend that, and so does what is known of loads (see loads.h).
 *
 * Sources: Suwelack 2014, chapter 7, with corrected factors: no 1/2 in f_phi and K_phi, and bounds on the growth of the
 * charge (q I_int / I_phi alone has an unstable fixed point). */
#ifndef REG_MATCH_H
#define REG_MATCH_H

#include "../softbody/body/body.h"
#include "field.h"

typedef enum reg_match_method {
    REG_PBSM = 0,        /* the potential is the distance: default */
    REG_PBSM_LAPLACE = 1 /* Laplace's potential on a grid, computed once at creation */
} reg_match_method;

/* Why a match is as far as it is. */
typedef enum reg_match_stop {
    REG_MATCH_RUNNING = 0,    /* more steps would help */
    REG_MATCH_SETTLED = 1,    /* full charge, and the mean distance no longer falls */
    REG_MATCH_STEP_CAP = 2,   /* the steps asked for are done */
    REG_MATCH_TIME_CAP = 3,   /* def.max_seconds are over */
    REG_MATCH_NO_OVERLAP = 4, /* less than def.least_active of the surface is near the target: nothing was moved */
    REG_MATCH_FAILED = 5      /* a step failed and was undone: info.error */
} reg_match_stop;

/* What a match is made from. Start from reg_default_match_def(), set body and a target. Lengths are shares of the
 * organ's size: the diagonal of its bounding box. */
typedef struct reg_match_def {
    sb_body *body;          /* volume mesh at rest or deformed; borrowed: the match moves it, and it must outlive the
                             * match. Supports hold their nodes where they are to be (sb_body_fix_nodes for regions
                             * known not to move); dead loads, springs and mappings act; constraints are refused.
                             * Gravity acts too: leave it 0 when the rest shape already hangs in it */
    const sb_mesh *surface; /* surface of the organ at rest, tri or quad, outward, or NULL (default): the boundary of
                             * the body; of one that an sb_cut has cut that of the mesh before, without lips and walls
                             * of holes. What was taken out of it does not count. Read at creation only */
    const sb_mesh *target;  /* surface that was seen, outward, in the same frame; or NULL, then: */
    const sb_vec3 *target_points;  /* [target_count] cloud (m) */
    const sb_vec3 *target_normals; /* [target_count] outward, or NULL */
    int target_count;
    reg_match_method method;
    int cells;   /* Laplace: of the grid along the longest side, [8, 256]; default 64 */
    int partial; /* 1: the target is a part of the surface: charges act by distance and normal. 0: all act.
                  * SB_AUTO (default): 1 for open surfaces and for clouds */
    sb_real reach, last_reach; /* partial: a charge acts within `reach`, which shrinks by 7 % a step to `last_reach`;
                                * both > 0; default 0.1, 0.02 */
    sb_real least_cosine;      /* partial: and where its normal and the target's have at least this cosine, [-1, 1];
                                * default 0.5 */
    sb_real least_active;      /* partial: least share of the surface's area that must act, [0, 1]; default 0.1. With
                                * landmarks it is not asked for */
    sb_real sampling;          /* half of it to each side of the target is where the potential is rounded off, > 0;
                                * default 0.015. The pull of a charge is full beyond and falls to 0 on the target */
    sb_real first_charge;      /* charge per area to begin with, in Young's moduli, > 0; default 0.2: finds the balance
                                * of loads normal to the surface. 7 takes half the steps and holds on to what is near
                                * from the beginning: better by a quarter where the surface was dragged along itself */
    sb_real last_charge;       /* and most of it, >= first_charge; default 100: the shape counts, the energy
                                * decides what it leaves open. Less follows noise less */
    sb_real least_growth, most_growth; /* of the charge in a step, 1 < least <= most; default 1.15, 2 */
    const sb_vec3 *landmarks;          /* [landmark_count] points on or in the organ at rest (m), or NULL */
    const sb_vec3 *landmark_targets;   /* [landmark_count] where they are seen (m) */
    int landmark_count;
    sb_real landmark_stiffness; /* of each one's spring, in Young's modulus times mean element size, > 0; default 50 */
    sb_real settled;            /* the mean distance has settled when it falls by less than this share three steps
                                 * running, > 0; default 0.005 */
    double max_seconds;         /* most time of all steps together, > 0; needs `clock`; default 1e9 */
    sb_clock clock;             /* default NULL: times read 0 */
    sb_allocator allocator;     /* default malloc; the threads are the body's */
    unsigned cookie;            /* set by reg_default_match_def */
} reg_match_def;
REG_API reg_match_def reg_default_match_def(void);

typedef struct reg_match reg_match;

/* How a match stands. Distances are those before the last step moved the body, since that is where it looked. */
typedef struct reg_match_info {
    int iterations; /* steps of this match so far */
    reg_match_stop stop;
    sb_real mean_distance;     /* of the active charges from the target, by area (m) */
    sb_real max_distance;      /* m */
    sb_real landmark_distance; /* largest, of landmarks from where they are seen (m) */
    sb_real active;            /* share of the surface's area that acts */
    sb_real charge;            /* Young's moduli */
    sb_real change;            /* largest displacement of a node in the last step (m) */
    int pcg_iterations;        /* of the last step */
    double seconds;            /* of all steps; with a clock, as are those of the last step: */
    double seconds_field;      /* looking for the target, */
    double seconds_system;     /* forces, tangent and preconditioner, */
    double seconds_solve;      /* and the linear system */
    sb_error error;            /* of a call that failed */
} reg_match_info;

/* Makes a match; the body is not touched. SB_ERROR_ARGUMENT (field named), SB_ERROR_NOT_FINITE, SB_ERROR_MATERIAL (no
 * Young's modulus to measure charges with), SB_ERROR_UNSUPPORTED (a body with constraints or custom elements),
 * what reg_field_create says of the target and sb_embedding_create of the surface (points far
 * outside included), SB_ERROR_MEMORY; *match is then untouched. All memory that steps need is taken here. */
REG_API sb_result reg_match_create(const reg_match_def *def, reg_match **match, sb_error *error);
REG_API void reg_match_destroy(reg_match *match); /* NULL is fine; the body stays */

/* One step: moves the body and raises the charge. info may be NULL. On failure the body is as before:
 * SB_ERROR_INVERTED (element named), SB_ERROR_INDEFINITE, SB_ERROR_DIVERGED (also when at full charge the organ
 * has less than a quarter or more than four times its volume); SB_ERROR_NOT_CONVERGED when too little of the
 * surface is near the target; SB_ERROR_UNSUPPORTED when the body has got constraints; SB_ERROR_STATE when its mesh has
 * changed: make a match of it anew. A recording of
 * the body holds the shape that it comes to, and replays without the match. Allocates nothing, unless loads were added
 * to the body since. The same bits for any number of threads. Landmarks and supports may move between steps: matching
 * then follows them. */
REG_API sb_result reg_match_step(reg_match *match, reg_match_info *info);
/* Steps until the match settles, `steps` (>= 0) are done or the time is up: all of these are SB_OK, and info->stop says
 * which. Errors as of a step. */
REG_API sb_result reg_match_run(reg_match *match, int steps, reg_match_info *info);
/* Back to the first charge and reach, as if no step had been: for a body that was reset or moved. The time goes on. */
REG_API void reg_match_restart(reg_match *match);

/* New places of the landmarks, targets[landmark_count] (m): between any two steps. SB_ERROR_NOT_FINITE names none and
 * changes nothing; a settled match runs again. */
REG_API sb_result reg_match_move_landmarks(reg_match *match, const sb_vec3 *targets);
/* Where the landmarks are now (m): points[landmark_count]; untouched when the body's mesh has changed. */
REG_API void reg_match_landmarks(const reg_match *match, sb_vec3 *points);

/* The body's: sb_body_positions and sb_body_displacements are the result. */
REG_API const sb_body *reg_match_body(const reg_match *match);
REG_API reg_match_info reg_match_get_info(const reg_match *match);

/* The charges, for pictures of what acts: [reg_match_sample_count]. */
typedef struct reg_match_sample {
    sb_vec3 point;    /* m, where the last step looked */
    sb_real area;     /* m^2 at rest */
    sb_real distance; /* m from the target */
    int active;
} reg_match_sample;
REG_API int reg_match_sample_count(const reg_match *match);
/* SB_ERROR_INDEX for no such sample; *sample is then untouched. */
REG_API sb_result reg_match_get_sample(const reg_match *match, int index, reg_match_sample *sample);

#endif /* REG_MATCH_H */
