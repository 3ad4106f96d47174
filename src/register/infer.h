/* infer: where an organ is and what shape it has, from what is seen of it, and how sure that is. Floor 6.
 *
 *     reg_model_def organ = reg_default_model_def();           (once per organ)
 *     organ.mesh = &mesh;
 *     reg_model_create(&organ, &model, &error);
 *     reg_infer_def def = reg_default_infer_def();
 *     def.model = model;
 *     def.target.points = points, def.target.count = count;    (a scan, m)
 *     def.start = start;                                       (reg_icp's, or whatever is known of the pose)
 *     reg_infer_run(&def, &infer, &error);
 *     reg_infer_displacements(infer, displacements);
 *     reg_infer_get_quality(infer, &quality);                  (quality.expected: the error to expect, m)
 *
 * Nobody knows what acts on an organ: gravity that turned, gas, an instrument, a neighbour that drags it, the hands
 * that hold it. So all of its surface may bear tractions, drawn from a Gaussian process whose scale and places are
 * chosen by what they explain (evidence, MacKay 1992), and its mass a weight in any direction; the organ's pose is open
 * within what the start is sure of. What is seen are gaps between the organ's surface and the points of the scan, each
 * with a deviation. Each round makes the organ's response linear about its present shape (neo-Hookean, exact for large
 * turns), finds the posterior of loads and pose (see gauss.h), and moves there. Where nothing holds the organ its loads
 * balance exactly.
 *
 * Every seen point asks for a place of the surface. What of the surface is not seen is not asked, so that views of any
 * part work, and the answer says how sure it is there: `expected`, from the posterior of loads and pose and from not
 * knowing the organ's stiffness (by a factor of 1.6 in regions of it) and Poisson's ratio (0.02).
 *
 * What to take it for: views of a part. Of organs of 280 mm at random, seven kinds of loads, mesh and law unlike the
 * model's, kept aside while it was tuned (26 views of 30 %, with and without 1 mm of noise; 13 of 10 %; 13 whole), the
 * mean errors were 2.7 mm (start 4.9, reg_loads 3.6), 5.5 (6.2, 5.2) and 1.2 (3.4, 1.0): closer than reg_loads in 20 of
 * 26 and 4 of 13 views, never above 1.1 times the rigid start's error. Of the nodes 93 %, 90 % (views of 10 %) and 93 %
 * were within their regions of 95 %. From a whole surface reg_loads was closer in 10 of 13: take that. (All that was
 * measured when the answer went all of the way, see `sure`.) Beyond that generator, in 1,200 cases of
 * examples/insilico that nothing was tuned on (prescribed motions of four kinds on six organs, whole and from three
 * sides down to 10 % of the surface, 0 to 3 mm of noise), errors were 0.87 times the start's in geometric mean, above
 * 1.1 times in nine, up to 1.5: dents by an instrument, which leave the pose as it is. 579 of 606 errors above 5 mm
 * expect more than that, but so do 204 of the 594 others: the true error scatters about what is expected by a factor
 * of 1.6. Give the model some 2,000
 * nodes.
 *
 * Sources: Rucker et al. 2013 and Heiselman et al. 2020 for responses to loads nobody knows; Matheron's rule for draws
 * (Wilson et al. 2021). */
#ifndef REG_INFER_H
#define REG_INFER_H

#include "icp.h"
#include "model.h"

/* What is seen of the organ. Everything is borrowed during the call. Zero-initialise. */
typedef struct reg_points {
    const sb_vec3 *points;  /* [count] m */
    const sb_vec3 *normals; /* [count] outward, of any length, 0: unknown; or NULL. They only forbid places of the model
                             * that face the other way */
    const sb_real *sd;      /* [count] standard deviation of a point across the surface (m), > 0; or NULL: estimated */
    const sb_real *weights; /* [count] >= 0, trust; or NULL: 1 */
    int count;
    const sb_mesh *surface; /* or, in place of points: a surface, tri or quad, of which the nodes count by area */
    int has_camera;         /* 1: seen from `camera` (m): facets of the model that look away are not seen */
    sb_vec3 camera;
} reg_points;

/* A point of the organ and where it is seen. */
typedef struct reg_landmark {
    sb_vec3 model; /* m, on or in the organ at rest */
    sb_vec3 seen;  /* m */
    sb_real sd;    /* standard deviation per axis (m), >= 0; 0: met exactly; infinite: counts nothing */
} reg_landmark;

/* A line of the organ and what is seen of it: a ridge, a rim, the root of a ligament, a vessel's centre line. It may
 * slide along itself. Doubling the corners of a line changes nothing: what is seen is taken every fiftieth of the
 * organ's size, at 32 places at most, each as sure as `sd` says. It is believed: what is taken for another line of the
 * organ draws the answer wrong. A vessel through nine random organs of 0.3 m, seen to 0.5 mm beside 30 % of their
 * surface, took mean errors from 4.2 to 2.2 mm; a quarter of it, beside a tenth, from 4.8 to 4.0. */
typedef struct reg_curve {
    const sb_vec3 *model; /* [model_count] m, corners of the line on or in the organ at rest; a part may be unseen */
    int model_count;      /* [2, 1000] */
    const sb_vec3 *seen;  /* [seen_count] m, corners of what is seen, in order, from either end */
    int seen_count;       /* >= 2 */
    sb_real sd;           /* standard deviation across the line, per axis (m), > 0; infinite: counts nothing */
} reg_curve;

/* What is asked. Start from reg_default_infer_def(), set model and target. */
typedef struct reg_infer_def {
    reg_model *model; /* borrowed; it must outlive the inference */
    reg_points target;
    const reg_landmark *landmarks; /* [landmark_count] or NULL */
    int landmark_count;
    const reg_curve *curves; /* [curve_count] or NULL */
    int curve_count;
    reg_rigid start;    /* model to target: a pose nearby; default: none but the model's own */
    sb_real start_sd;   /* of the place that it gives the organ's middle (m), at most 100 of its sizes; default 0: 0.07
                         * of the size */
    sb_real start_turn; /* and of its turn (rad), in (0, 10]; default 0.2 */
    int gravity;        /* 1 (default): the weight may have changed, as where a patient is turned; 0: it did not */
    const sb_real *pressed; /* [model's nodes], in [0, 1], or NULL (default): a pressure, of either sign and any size,
                             * may press on the skin besides, with such a share of it at each node: gas in the abdomen
                             * on what it reaches, water in a cyst. Say so where you know it: of other loads nobody
                             * expects that they are alike in all places. Its sum is carried by other loads. Where all
                             * is seen its size is found, too (a sphere's to 3 %). Of 11 random organs under gas, a
                             * third seen from above, it hardly was; errors were 0.96 of those without the hint on
                             * the mean, from 0.71 to 1.30. A region that nothing pressed on changed none of seven by
                             * more than 1 % of it */
    int samples;            /* patches that the target is grouped into, [30, 1000]; default 300. Time grows with it */
    int rounds;             /* at most, [1, 100]; default 5: more gain little */
    double max_seconds;     /* > 0, with a clock: no round begins that would end later; default 1e9 */
    sb_clock clock;         /* default NULL: times read 0 */
    unsigned cookie;        /* set by reg_default_infer_def */
} reg_infer_def;
REG_API reg_infer_def reg_default_infer_def(void);

typedef struct reg_infer reg_infer;

/* Infers; all memory is taken here, from the model's allocator. SB_ERROR_ARGUMENT (a field, named),
 * SB_ERROR_NOT_FINITE (error->node: the point, the landmark or the curve), what sb_surface_create says of a target
 * surface, SB_ERROR_NOT_CONVERGED (no point of the target has an allowed place of the model, or loads cannot be told),
 * SB_ERROR_INDEFINITE, SB_ERROR_MEMORY: *infer is then untouched. Deterministic; the same bits for any number of
 * threads, without a time limit. */
REG_API sb_result reg_infer_run(const reg_infer_def *def, reg_infer **infer, sb_error *error);
REG_API void reg_infer_destroy(reg_infer *infer); /* NULL is fine; the model stays */

/* ---- the answer: SB_ERROR_ARGUMENT for NULL -------------------------------------------------------------------- */

/* displacements[nodes] (m) of the model's nodes from rest to where they are in the target's frame. Where less than 15 %
 * of the surface is seen and no landmark or curve was given, a tenth tells too little of the rest: the answer is then
 * half the way from the start to the elastic shape, or the start where loads explain no more than a pose does
 * (quality.belief). Without landmarks and curves all answers stop short of the elastic shape by as much as it is unsure
 * for how far from the start it is (quality.sure). What is left of the way is in the errors to expect. */
REG_API sb_result reg_infer_displacements(const reg_infer *infer, sb_vec3 *displacements);
/* forces[nodes] (N for a Young's modulus of 1000 Pa: they scale with it) that are found to act, weight included: those
 * of the whole way, of which the answer goes quality.sure. */
REG_API sb_result reg_infer_forces(const reg_infer *infer, sb_vec3 *forces);
/* expected[nodes]: root mean square error (m) to expect of each node. */
REG_API sb_result reg_infer_expected(const reg_infer *infer, sb_real *expected);
/* One of the REG_INFER_DRAWS shapes that agree with what was seen, as displacements[nodes] (m) like the answer's: to
 * see in how many of them a path misses. SB_ERROR_INDEX. */
enum { REG_INFER_DRAWS = 32 };
REG_API sb_result reg_infer_draw(const reg_infer *infer, int index, sb_vec3 *displacements);
/* Where points[count] of the organ at rest (m) are, moved[count], and the covariance of that, covariances[count] (m^2);
 * either may be NULL. SB_ERROR_NOT_FINITE, what sb_embedding_create says of points far off, SB_ERROR_MEMORY
 * leave both untouched. From the draws, so that single covariances are known to a quarter. */
REG_API sb_result reg_infer_covariance(const reg_infer *infer, const sb_vec3 *points, int count, sb_vec3 *moved,
                                       sb_mat3 *covariances, sb_error *error);
/* Which of points[count] of the organ at rest (m) is worth touching: the one that, seen as a landmark of deviation `sd`
 * (m, >= 0), lowers the mean error to expect most, and what that would then be, expected (m); it may be NULL. It takes
 * the draws for all that may be (regression on them); that with a landmark an answer goes the whole way is not in it.
 * Of three random organs seen from above 7.0 to 7.8 mm became 5.2 to 5.8, foretold 5.5 to 6.3; the best of nine points
 * was found in two of them, in the third one 1.2 times as good as that. SB_ERROR_ARGUMENT, and as above: nothing is
 * written then. 1 ms per point for 2,000 nodes. */
REG_API sb_result reg_infer_best_landmark(const reg_infer *infer, const sb_vec3 *points, int count, sb_real sd,
                                          int *best, sb_real *expected, sb_error *error);

/* ---- how good it is --------------------------------------------------------------------------------------------- */

typedef enum reg_infer_stop {
    REG_INFER_CONVERGED = 0, /* the last round moved no node by a thousandth of the size */
    REG_INFER_ROUNDS = 1,    /* the rounds asked for are done */
    REG_INFER_CAPPED = 2     /* time was up */
} reg_infer_stop;

/* What the loads that won are like. */
typedef enum reg_prior_kind {
    REG_PRIOR_RIGID = 0,   /* loads explain hardly more than a pose does: by less than 3 nats */
    REG_PRIOR_SMOOTH = 1,  /* tractions of like size everywhere */
    REG_PRIOR_LOCAL = 2,   /* tractions of some places */
    REG_PRIOR_GRAVITY = 3, /* a weight, and tractions that carry it */
    REG_PRIOR_PRESSURE = 4 /* a pressure on what is `pressed`, of 3 nats or more, and other tractions; there may be a
                            * weight, too */
} reg_prior_kind;

typedef struct reg_quality {
    reg_infer_stop stop;
    unsigned warnings; /* REG_WARN_..., or-ed. VIEW_SMALL: also where the error to expect is above 0.03 of the size;
                        * LOW_CONTRAST: the pose is open by 2 % of the size or 5 degrees */
    reg_prior_kind prior;
    sb_real prior_margin;             /* log evidence over that of no loads, tempered */
    sb_real pressure_margin;          /* log evidence of a pressure on what is pressed over none, tempered; 0: none */
    sb_real pressure;                 /* found there, for a Young's modulus of 1000 Pa (Pa, > 0: inwards) */
    sb_real belief;                   /* share of the way from the start to the elastic shape that the answer goes: */
    sb_real sure;                     /* this times that; less than 1 the less sure the way is for its length */
    sb_real seen;                     /* share of the model's surface with points of the target near */
    sb_real used;                     /* share of the target's weight that was believed */
    sb_real noise;                    /* m: standard deviation of the points across the surface, estimated */
    sb_real misfit;                   /* m: of what does not average out, as facets, chosen by evidence */
    sb_real residual, residual_p95;   /* m: distances of the points believed, mean and 95th percentile */
    sb_real expected, expected_worst; /* m: root mean square error to expect, mean over nodes, and of the worst */
    sb_real pose_sd[2];               /* m, rad: largest of the pose's deviations */
    sb_real largest_strain;           /* |principal stretch - 1|, of all points of elements */
    sb_real volume_ratio;
    sb_real change; /* m: largest displacement in the last round */
    int rounds;
    double seconds;          /* of all, with a clock; among them for */
    double seconds_response; /* stiffness, its factor and the patches' responses, */
    double seconds_choice;   /* the choice of the prior, */
    double seconds_draws;    /* and what the error to expect comes from */
} reg_quality;
/* SB_ERROR_ARGUMENT. */
REG_API sb_result reg_infer_get_quality(const reg_infer *infer, reg_quality *quality);
/* "rigid", "smooth", "local", "gravity", "pressure"; "converged", "rounds", "time". */
REG_API const char *reg_prior_string(reg_prior_kind prior);
REG_API const char *reg_infer_stop_string(reg_infer_stop stop);

#endif /* REG_INFER_H */
