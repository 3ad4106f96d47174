/* track: follows an organ that moves, scan by scan. Floor 6.
 *
 *     reg_track_def def = reg_default_track_def();
 *     def.model = model;
 *     def.start = infer;                                  (of the first scan; or def.pose)
 *     reg_track_create(&def, &track, &error);
 *     every frame:
 *         reg_track_set_target(track, &points, &error);   (the scan of now; none where it dropped out)
 *         reg_track_set_features(track, marks, NULL, &error); (landmarks and curves of now, if def names some)
 *         reg_track_step(track, dt, &info);
 *         reg_track_displacements(track, displacements);
 *     reg_track_destroy(track);
 *
 * Where an inference (infer.h) takes part of a second to find an organ of which nothing is known, a tracker takes
 * milliseconds to follow one that is known. Its state is a pose and the amounts of `modes` shapes, those that carry
 * most of what tractions drawn from the prior do to the organ; all is Gaussian. Between scans the pose wanders, and the
 * amounts go back to the start as a process of Ornstein and Uhlenbeck does, so that errors to expect grow in a
 * drop-out, but not beyond what loads may do. A scan brings gaps between the surface and the points, as rows of the
 * state; places on the surface are looked for twice. Each target counts in one step. What a coarse surface is off by
 * does not average out over frames: so the change since the last frame is drawn from a prior whose scale evidence
 * chooses, and the error to expect is what this frame alone leaves open. (A Kalman filter that takes such errors for
 * noise grows sure of them, and drifts.) Three targets on end that agree with nothing that was expected (gaps too
 * large, or far fewer points than lately to be believed) are a jump: all is open again about where the organ was, and
 * the next frames search wider.
 *
 * What to take it for: five random organs of 0.3 m, of another mesh and law than the model's (450 to 530 nodes), drawn
 * by 3 % of their size over a wide part and swaying, seen from above by 600 points of 0.7 mm noise ten times a second:
 * 1.5 to 2.1 mm off inside on the mean (2.7 to 3.4 expected), where a tracker of poses is 1.9 to 2.5 off; worst 1.06
 * times that. A breathing liver (examples/track_liver.c): 1.1 mm, 2.0 expected, 2.3 in drop-outs of 0.4 s. A frame of
 * 700 points and a model of 1,887 nodes takes 3 ms of one core.
 *
 * What is left is no lag and no noise, but what a smooth surface does not tell: how it slides along itself. Without
 * noise, at 30 Hz, or with all of the surface seen errors are the same (2.1, 2.1 and 2.2 mm of five organs; the best
 * rigid motion is 1.7 off, the best amounts of the shapes 0.5), and the error to expect says so. Landmarks and curves
 * do tell (reg_track_set_features): of ten organs whose upper third is seen, 2.3 -> 1.8 mm with two points of the
 * flanks and a ridge below; of the breathing liver 1.1 -> 0.53 with two points and two lines.
 *
 * The shapes are linear about the start. Strains of a tenth, or parts that turn by 20 degrees against each other, are
 * beyond that: restart about where the organ is then (reg_track_restart).
 *
 * Sources: MacKay 1992 for evidence; Halko et al. 2011 for the search of shapes. */
#ifndef REG_TRACK_H
#define REG_TRACK_H

#include "infer.h"

/* What is asked. Start from reg_default_track_def(), set model. */
typedef struct reg_track_def {
    reg_model *model;       /* borrowed; it must outlive the tracker. Steps leave it alone, so that an inference may use
                             * it meanwhile; creation and restarts use it as an inference does */
    const reg_infer *start; /* of this model: where the organ is and what shape it has, read during the call; or NULL */
    reg_rigid pose;         /* for start NULL: the organ is at rest there; default: none but the model's own */
    sb_real pose_sd;        /* m: what the place of the organ's middle may be off at the start; default 0: what `start`
                             * says, or 0.02 of the size */
    sb_real pose_turn;      /* rad, in [0, 10]: and its turn; default 0: what `start` says, or 0.05 */
    int modes;              /* shapes, [1, 96]; default 48 */
    int patches;            /* of the surface, whose points count as one datum each, [30, 1000]; default 300 */
    int most_points;        /* of a target, [1, 10000000]; default 2000 */
    sb_real motion;         /* m: root mean square motion of the nodes by loads to expect, beside the pose; default 0:
                             * 0.03 of the size */
    sb_real memory;         /* s, > 0: in that amounts go back towards the start; default 1 */
    sb_real wander;         /* m: deviation of the middle after a second, per axis; default 0: 0.04 of the size */
    sb_real turn;           /* rad, in [0, 10]: and of the turn; default 0: 0.15 */
    sb_real misfit;         /* m: of what does not average out, as facets; default 0: what `start` found, or what the
                             * model's nodes let expect */
    double lost_after;      /* s, > 0: without a target or features for longer the organ is lost; default 0.5 */
    const reg_landmark *landmarks; /* [landmark_count] or NULL: points of the organ that frames may tell of. Their
                                    * `model` is copied; where they are seen, and how sure, comes with each frame */
    int landmark_count;            /* [0, 1000] */
    const reg_curve *curves;       /* [curve_count] or NULL: lines of the organ likewise: ridges, vessels */
    int curve_count;               /* [0, 1000] */
    sb_clock clock;                /* default NULL: times read 0 */
    unsigned cookie;               /* set by reg_default_track_def */
} reg_track_def;
REG_API reg_track_def reg_default_track_def(void);

typedef struct reg_track reg_track;

/* Makes a tracker; all memory is taken here, from the model's allocator. Takes the time of a round of an inference.
 * SB_ERROR_ARGUMENT (a field, named), SB_ERROR_INVERTED, SB_ERROR_INDEFINITE, SB_ERROR_MEMORY: *track is then
 * untouched. Deterministic, as steps are; the same bits for any number of threads. */
REG_API sb_result reg_track_create(const reg_track_def *def, reg_track **track, sb_error *error);
REG_API void reg_track_destroy(reg_track *track); /* NULL is fine; the model stays */

/* Begins anew about an inference's answer, or, `start` NULL, about where the organ is now: shapes are linear about
 * that, what was known of the amounts is forgotten, and the pose is as sure as at a start. For after it was lost, and
 * for large deformations. Allocates nothing; takes as long as the creation. The errors of reg_track_create: nothing
 * has changed then. A target that waits stays. */
REG_API sb_result reg_track_restart(reg_track *track, const reg_infer *start, sb_error *error);

/* What is seen now, for the next step; replaces a target that waits. Copied. A surface is refused. SB_ERROR_ARGUMENT,
 * also for more than def.most_points, and SB_ERROR_NOT_FINITE (error->node: the point): nothing has changed. */
REG_API sb_result reg_track_set_target(reg_track *track, const reg_points *target, sb_error *error);

/* Which of the def's landmarks and curves are seen now, and where, for the next step: landmarks[def.landmark_count] and
 * curves[def.curve_count] in the def's order, of which `seen` and `sd` are read and copied. An infinite sd stands for
 * what is not seen now: it counts nothing, and its `seen` is not looked at. Replaces features that wait; a step takes
 * them in beside a target or without one. They are rows of the state, as patches of the target are, but counted for
 * what they are by themselves: the farther one is off what was expected of it, the less it counts (Student's t of three
 * degrees of freedom), so that one that is taken for another does little, while all that move alike are followed.
 * Deviations below a ten-thousandth of the organ's size count as that.
 *
 * NULL where the def has none. SB_ERROR_ARGUMENT (NULL, an sd out of its range, a line without length, a place farther
 * than 100 of the organ's sizes from where it is: most often one in millimetres) and SB_ERROR_NOT_FINITE name the
 * landmark or curve (error->node): nothing has changed. Allocates nothing. */
REG_API sb_result reg_track_set_features(reg_track *track, const reg_landmark *landmarks, const reg_curve *curves,
                                         sb_error *error);

typedef enum reg_track_state {
    REG_TRACK_FOLLOWS = 0,  /* the target was taken in */
    REG_TRACK_PREDICTS = 1, /* there was none, nor a feature, nothing of it had an allowed place, or the step failed:
                             * the organ is where it was */
    REG_TRACK_JUMPED = 2,   /* three targets in a row agreed with nothing that was expected: all is open again */
    REG_TRACK_LOST = 3      /* no target for longer than def.lost_after: restart, from reg_icp's or another pose */
} reg_track_state;

typedef struct reg_track_info {
    reg_track_state state;
    double time;      /* s: sum of all steps */
    double blind;     /* s since the last target that was taken in */
    sb_real seen;     /* share of the surface with points that are believed, this frame */
    sb_real used;     /* share of the target's weight that was believed */
    sb_real noise;    /* m: standard deviation of the points across the surface, estimated */
    sb_real trusted;  /* of landmarks and places of curves seen: how much they count, [0, 1], mean; 0: none was seen */
    sb_real residual; /* m: mean distance of the points believed from the surface, before the last correction */
    sb_real innovation; /* squared gaps over what was expected of them, mean: about 1 or less */
    sb_real expected;   /* m: root mean square error to expect, over the nodes */
    double seconds;     /* with a clock */
    sb_error error;     /* of a step that failed */
} reg_track_info;

/* Goes on by dt (s, > 0), and takes in the target and the features that wait, if there are any. Allocates nothing. info
 * may be NULL. SB_ERROR_ARGUMENT, SB_ERROR_INDEFINITE, SB_ERROR_NOT_FINITE: nothing has changed but that target and
 * features are gone. */
REG_API sb_result reg_track_step(reg_track *track, double dt, reg_track_info *info);

/* ---- where it is: SB_ERROR_ARGUMENT for NULL -------------------------------------------------------------------- */

/* displacements[nodes] (m) of the model's nodes from rest to where they are in the target's frame. */
REG_API sb_result reg_track_displacements(const reg_track *track, sb_vec3 *displacements);
/* covariances[nodes] (m^2) of that, in the target's frame. Some (modes + 6)^2 multiply-adds a node: for a look now and
 * then, not for each frame. */
REG_API sb_result reg_track_covariances(const reg_track *track, sb_mat3 *covariances);

/* ---- undo, replays, a start where another run ended -------------------------------------------------------------- */

/* A saved tracker holds all that steps, restarts and targets change, what waits included: what follows a load
 * is what followed the save, bit for bit, also in another process or machine. It is loaded into a tracker of the same
 * model that was made with the same def (most_points may differ), in the same precision. Some
 * 3 (modes + 1) reals a node. The model and its body are not part of it: steps leave them alone.
 *
 * size: bytes that save writes for the tracker as it is; 0 for NULL. save: what is behind them stays.
 * SB_ERROR_ARGUMENT: NULL, or too small a buffer (then untouched). Neither allocates. */
REG_API size_t reg_track_save_size(const reg_track *track);
REG_API sb_result reg_track_save(const reg_track *track, void *buffer, size_t size);
/* Allocates nothing. Everything is checked first; on failure the tracker is as it was: SB_ERROR_ARGUMENT (NULL),
 * SB_ERROR_FORMAT (no saved tracker, cut short, damaged, a number out of its range), SB_ERROR_UNSUPPORTED (other
 * version or precision), SB_ERROR_STATE (another model's or def's), SB_ERROR_NOT_FINITE. */
REG_API sb_result reg_track_load(reg_track *track, const void *buffer, size_t size, sb_error *error);

/* "follows", "predicts", "jumped", "lost". */
REG_API const char *reg_track_state_string(reg_track_state state);

#endif /* REG_TRACK_H */
