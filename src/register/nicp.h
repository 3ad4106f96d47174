/* nicp: non-rigid ICP: an elastic organ whose visible surface is drawn to its closest points of a target. Floor 6.
 *
 * Points of the organ's surface, the sources, are paired with the target both ways: each source i with the closest
 * place N_s(i) of the target, and each point j of the target with its closest source N_t(j). A source is drawn by
 *     u_i = alpha [p(N_s(i)) - p(i)] + (1 - alpha) mean_{j in V(i)} [p(j) - p'(j)],   V(i) = {j: N_t(j) = i},
 * p'(j) being the place of the organ's surface closest to j; alpha = 1 where V(i) is empty. Pairs that are too far
 * apart for the rest, that look different ways, or that end on the rim of what was seen do not count; nor do sources
 * that the camera does not see. A penalty draws the sources to y = p + u, and the body finds its balance:
 *     f_int(u) + H K (H^T x - y) = loads,   K = k [(1 - s) I + s n n^T]
 * with n across the target and a share s by which it is softer along it. Then all is looked at anew. k grows from
 * increment to increment, k = k0 (k1 / k0)^(i / n): gentle as long as pairs are guesses, firm when they can be trusted.
 *
 * Match (match.h) does the same job by a potential instead of pairs. This one follows scans without normals, uses the
 * camera, and takes bodies in weighted-cell grids and with constraints.
 *
 * Source: Brunet 2020, chapter 5, algorithm 3, with the corrected schedule of k, sign of the penalty and loop counters;
 * its mean over V(i) is of p(j) - p(i), in which the sources' spacing shows as noise along the surface. */
#ifndef REG_NICP_H
#define REG_NICP_H

#include "../softbody/body/body.h"
#include "../softbody/geometry/grid.h"
#include "cloud.h"
#include "field.h"

/* Which sources may be paired. */
typedef enum reg_nicp_view {
    REG_NICP_ALL = 0,    /* all: default; an open target or a cloud tells by itself what it does not show */
    REG_NICP_FACING = 1, /* those whose normal looks to the camera's side */
    REG_NICP_VISIBLE = 2 /* of these, those that no part of the organ hides from the camera */
} reg_nicp_view;

/* Why a run is as far as it is. */
typedef enum reg_nicp_stop {
    REG_NICP_RUNNING = 0,    /* more iterations would help */
    REG_NICP_CONVERGED = 1,  /* two increments running gave the same shape */
    REG_NICP_INCREMENTS = 2, /* the last increment is done */
    REG_NICP_STEP_CAP = 3,   /* the iterations asked for are done */
    REG_NICP_TIME_CAP = 4,   /* def.max_seconds are over */
    REG_NICP_NO_OVERLAP = 5, /* less than def.least_active of the surface has a partner: nothing was moved */
    REG_NICP_FAILED = 6      /* no balance was found, and the body is as before: info.error */
} reg_nicp_stop;

/* What a registration is made from. Start from reg_default_nicp_def(), set body and a target. Lengths are shares of the
 * organ's size: the diagonal of its bounding box. */
typedef struct reg_nicp_def {
    sb_body *body;          /* at rest or deformed; borrowed: it is moved, carries the penalties as mappings (load.h)
                             * while the registration lives, of stiffness 0 between its steps, and must outlive it.
                             * Its supports, loads and constraints act. Gravity too: leave it 0 when the rest shape
                             * already hangs in it */
    const sb_grid *grid;    /* NULL; or the grid whose body_mesh the body has: `surface` is then needed, and goes
                             * through the grid's mapping. Read at creation only, as are all below */
    const sb_mesh *surface; /* surface of the organ at rest, tri or quad, outward, or NULL (default): the boundary of
                             * the body, of one that is cut as a match takes it (see match.h) */
    int sources;            /* most of the surface's vertices that are paired, evenly spread, >= 4; default 4000 */
    const sb_mesh *target;  /* surface that was seen, outward, in the same frame; or NULL, then: */
    const sb_vec3 *target_points;  /* [target_count] cloud (m) */
    const sb_vec3 *target_normals; /* [target_count] outward, or NULL */
    int target_count;
    int samples; /* most points of the target that look for sources, evenly spread, >= 0; default 2000 */
    reg_nicp_view view;
    sb_vec3 camera;        /* where it was seen from (m), in the target's frame; with FACING and VISIBLE */
    sb_real blending;      /* alpha, [0, 1]; default 0.75. 1: only N_s counts */
    sb_real sliding;       /* s, [0, 1]; default 0.999: the organ may slide along the target, whose closest places say
                            * little about that. 0: as in the source, which costs a third of the accuracy. With 1
                            * nothing holds a ball that may turn */
    int noisy;             /* 1: n is the normal of the organ and not that of the target: less is made of the
                            * target's shape, and less of its noise (1 mm on triangles of 4 mm); default 0 */
    sb_real least_cosine;  /* least cosine of the normals of partners, [-1, 1]; default 0.3. Not asked for where the
                            * target has no normals */
    reg_outliers outliers; /* pairs that are too far apart, see reg_outlier_limit; default REG_OUTLIERS_MEDIAN */
    sb_real outlier_parameter; /* default 3 */
    sb_real reach, last_reach; /* pairs nearer than this never are, > 0: falls from increment to increment; default 0.1,
                                * 0.03 */
    sb_real first_stiffness;   /* penalty per area to begin with, in Young's modulus over organ size, > 0;
                                * default 300. Where the organ bends by more than a tenth of its size: 30 */
    sb_real last_stiffness;    /* and in the end, >= first_stiffness; default 30,000. Noisy targets want less: 1000 */
    int increments;            /* of the stiffness, >= 1; default 4 */
    int iterations;            /* most looks at the target in an increment, >= 1; default 2 */
    int newton;                /* most Newton iterations of a balance, >= 1; default 6 */
    sb_real newton_tolerance;  /* of its forces, (0, 1); default 0.07: the next look changes them more than that */
    sb_real tolerance;         /* rms motion of the surface that counts as none, > 0; default 5e-5 */
    sb_real least_active;      /* least share of the surface's area with a partner, [0, 1]; default 0.05. Not asked for
                                * with landmarks */
    const sb_vec3 *landmarks;  /* [landmark_count] points on or in the organ at rest (m), or NULL */
    const sb_vec3 *landmark_targets; /* [landmark_count] where they are seen (m) */
    int landmark_count;
    sb_real landmark_stiffness; /* of each one's spring, in Young's modulus times mean element size, > 0; default 50 */
    double max_seconds;         /* most time of all steps together, > 0; needs `clock`; default 1e9 */
    sb_clock clock;             /* default NULL: times read 0 */
    sb_allocator allocator;     /* default malloc; the threads are the body's */
    unsigned cookie;            /* set by reg_default_nicp_def */
} reg_nicp_def;
REG_API reg_nicp_def reg_default_nicp_def(void);

typedef struct reg_nicp reg_nicp;

/* How it stands. Distances are those before the last step moved the body, since that is where it looked. */
typedef struct reg_nicp_info {
    int iterations; /* looks at the target so far */
    int increment;  /* of the stiffness, from 1 */
    reg_nicp_stop stop;
    sb_real mean_distance;     /* of paired sources from the target, by area (m) */
    sb_real max_distance;      /* m */
    sb_real landmark_distance; /* largest, of landmarks from where they are seen (m) */
    sb_real active;            /* share of the surface's area that is paired */
    int visible;               /* sources that the camera sees */
    int pruned;                /* sources whose partner was too far away, looked elsewhere, or lay on the rim */
    sb_real stiffness;         /* penalty per area (Pa/m) */
    sb_real change;            /* rms motion of the sources in the last step (m) */
    int newton_iterations;     /* of the last step */
    int pcg_iterations;
    double seconds;       /* of all steps; with a clock, as are those of the last step: */
    double seconds_pairs; /* looking for partners, */
    double seconds_solve; /* and finding the balance */
    sb_error error;       /* of a call that failed */
} reg_nicp_info;

/* Makes a registration; the body's shape is not touched, its loads get the penalties, with no force yet.
 * SB_ERROR_ARGUMENT (field named), SB_ERROR_NOT_FINITE, SB_ERROR_MATERIAL (no Young's modulus to measure the penalty
 * with), what reg_field_create says of the target, what sb_surface_create, sb_embedding_create and sb_grid_map_points
 * say of the surface and the landmarks, SB_ERROR_UNSUPPORTED (a body of custom elements), SB_ERROR_MEMORY; *nicp and
 * the body are then untouched. */
REG_API sb_result reg_nicp_create(const reg_nicp_def *def, reg_nicp **nicp, sb_error *error);
REG_API void reg_nicp_destroy(reg_nicp *nicp); /* NULL is fine; takes the penalties away; the body stays as it is */

/* One look at the target and the balance after it. info may be NULL. On failure the body is as before:
 * SB_ERROR_NOT_CONVERGED when too little of the surface has a partner, SB_ERROR_DIVERGED when the organ has less than a
 * quarter or more than four times its volume, and what sb_body_solve_static says; SB_ERROR_STATE
 * when its mesh has changed: make a registration of it anew. Allocates nothing. The same bits for any number
 * of threads. A recording of the body holds the penalties and the balance, and replays without the registration. */
REG_API sb_result reg_nicp_step(reg_nicp *nicp, reg_nicp_info *info);
/* Steps until the shape converges, the increments or `steps` (>= 1) are done, or the time is up: all of these are
 * SB_OK, and info->stop says which. Errors as of a step. */
REG_API sb_result reg_nicp_run(reg_nicp *nicp, int steps, reg_nicp_info *info);
/* Back to the first increment, as if no step had been: for a body that was reset or moved. The time goes on. */
REG_API void reg_nicp_restart(reg_nicp *nicp);

/* New places of the landmarks, targets[landmark_count] (m): between any two steps. SB_ERROR_NOT_FINITE changes nothing;
 * a run that had ended goes on with the last increment. */
REG_API sb_result reg_nicp_move_landmarks(reg_nicp *nicp, const sb_vec3 *targets);
/* Where the landmarks are now (m): points[landmark_count]; untouched when the body's mesh has changed. */
REG_API void reg_nicp_landmarks(const reg_nicp *nicp, sb_vec3 *points);

/* The body's: sb_body_positions and sb_body_displacements are the result. */
REG_API const sb_body *reg_nicp_body(const reg_nicp *nicp);
REG_API reg_nicp_info reg_nicp_get_info(const reg_nicp *nicp);
/* Where the surface is now: points[reg_nicp_surface_count] (m), the vertices of def.surface, or the boundary's nodes in
 * the order of sb_mesh_boundary; untouched when the body's mesh has changed. Through the grid's mapping for bodies in
 * grids. */
REG_API int reg_nicp_surface_count(const reg_nicp *nicp);
REG_API void reg_nicp_positions(const reg_nicp *nicp, sb_vec3 *points);

/* The sources, for pictures of what is paired: [reg_nicp_source_count]. */
typedef struct reg_nicp_source {
    int vertex;       /* of the surface */
    sb_vec3 point;    /* m, where the last step looked */
    sb_vec3 goal;     /* m, where it was drawn to */
    sb_real area;     /* m^2 at rest that it stands for */
    sb_real distance; /* m from the target */
    int visible, active;
} reg_nicp_source;
REG_API int reg_nicp_source_count(const reg_nicp *nicp);
/* SB_ERROR_INDEX for no such source; *source is then untouched. */
REG_API sb_result reg_nicp_get_source(const reg_nicp *nicp, int index, reg_nicp_source *source);

#endif /* REG_NICP_H */
