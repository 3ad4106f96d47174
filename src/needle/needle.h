/* needle: flexible needles in soft tissue. A sleeve feeds, turns and moves a needle; its tip cuts, its shaft sticks and
 * slips, and the tissue's mesh follows. Floor 6. Chapters 7 to 10 of Chentanez 2010.
 *
 *     ndl_needle_def def = ndl_default_needle_def();
 *     def.body = body;
 *     def.base = sb_v3(0, 0, 0.1), def.direction = sb_v3(0, 0, -1);
 *     ndl_needle_create(&def, &needle, &error);
 *     command.insertion = 0.01;                                    (1 cm/s)
 *     ndl_step(body, &needle, 1, 0.02, &command, &info, &error); */
#ifndef NDL_NEEDLE_H
#define NDL_NEEDLE_H

#include "../softbody/body/step.h"
#include "couple.h"
#include "remesh.h"
#include "rod.h"
#include "steer.h"

enum { NDL_MAX_NEEDLES = 16 }; /* in one body */

typedef struct ndl_needle ndl_needle;

/* ---- what tissue does to a needle ---- */

/* What a region of tissue does to a needle, whatever presses on it (Tresca friction). All >= 0, default 0. */
typedef struct ndl_friction {
    sb_real friction; /* N/m along the shaft: while less is needed the needle sticks, when it slips it feels this. Of
                       * the order of 10 to 100 in soft tissue */
    sb_real viscous;  /* N s/m^2: more for slip at 1 m/s */
    sb_real cutting;  /* N at the tip while it goes forward; of the order of 1 */
    sb_real twist_stiffness; /* N m/rad per m of shaft: tissue that sticks holds against turning, */
    sb_real twist_friction;  /* up to this torque, N m per m of shaft. Both 0: the needle turns freely */
} ndl_friction;

/* A face between regions, as of a capsule, which must be punctured: the tip needs `strength` beside the cutting force
 * of the harder of its regions while it is within half of `thickness` of that face (in the undeformed tissue). A step
 * is divided where a tip comes into that or out of it, so that what a hand feels hardly depends on dt and speed: of 100
 * random needles at up to 40 degrees, 5 to 100 mm/s and dt 5 to 50 ms all peaks were within 10 % of strength, cutting
 * and friction. With NDL_REMESH the mesh may add to that (1 of 60: 7 N), and at a skin it does. */
typedef struct ndl_membrane {
    int regions[2];    /* on its two sides; -1: outside of the tissue (the skin) */
    sb_real strength;  /* N, >= 0 */
    sb_real thickness; /* m, > 0 */
} ndl_membrane;

/* Force (N, >= 0) to cut at the material point X (m) of a region, instead of the table's cutting and membranes. Not
 * negative, not NaN (taken for 0). Called once per step and needle in the tissue. */
typedef sb_real (*ndl_cutting)(void *user, sb_vec3 X, int region);

/* ---- creation ---- */

/* How a needle is in the tissue.
 *
 * Which to take: NDL_EMBED, the default, wherever forces, bends or places matter, in soft tissue above all, in other
 * elements than tet4, in cut bodies, for needles close together. NDL_REMESH (what Chentanez 2010 has) where nodes are
 * wanted on the needle's line, or steps have to be cheap: it takes 0.6 times the time in a gel phantom of 24 x 24 x 3
 * cells. Of 200 needles into random ellipsoids none felt 0.05 N more than friction and cutting in any step; of 5,240
 * into six organs, whose lowest sixth is held, 6 felt more than three times them and 0.2 N, by up to 3 N, unless their
 * tips were stopped (ndl_step_info.blocked). Nearly along the skin needles may tear out (ndl_step_info.torn): of 60
 * wires of 1.8 mm at 63 to 86 degrees from its normal, in 14 kPa, 6 did so, with NDL_EMBED none. Markers of that
 * phantom are off those of a finer mesh by 0.107 mm with NDL_REMESH, 0.022 with NDL_EMBED (RMS; needle_phantom);
 * lateral stiffness changes 1.9 times over edges from 17 to 7 mm with NDL_REMESH; in 50 kPa a bend is 0.82 to 1.56 of
 * its law with NDL_REMESH (ndl_step_info.coarse says when), 0.99 to 1.06 with NDL_EMBED. A nitinol needle 28 mm deep in
 * 30 kPa that is drawn back takes tissue with it by 422 N/m, as a line of its radius in a tube of 30 mm, and its tip by
 * some more: with edges of 12 and 7.5 mm NDL_EMBED has 484 and 436 N/m, NDL_REMESH 1050 and 920. So after 4 mm of the
 * way NDL_REMESH slips, and holds all of the friction (0.82 N), while NDL_EMBED still sticks, as a needle would (0.43
 * N); after 10 mm both hold friction times depth. Templates: 4 and 16 held needles 5 mm apart, in edges of 5 and 10 mm,
 * feel friction and cutting to 1 %.
 *
 * With NDL_EMBED the shaft is held by springs at material points. They are what the mesh does not show of the tissue
 * close to the needle (couple_rows.h), so that what a hand feels hardly depends on the mesh: an 18-gauge or nitinol
 * needle 45 mm deep in 12 to 240 kPa is within 6 % of the lateral stiffness of the needle as a solid in a mesh graded
 * to it, with edges from 20 to 5 mm (needle_study --all), 5 % above it in a mesh that is uneven and distorted, 4 to 8 %
 * below it in other elements than tet4. Shafts stay on what their tips cut, to 0.05 mm in stiff gel. Needles enter
 * where they meet the skin: of 200 into random ellipsoids none felt 0.02 N more than friction and cutting in any step.
 * Under load the rod is ahead of its material points, by 1 mm of 20 N/m and 3 mm at a tip of 0.5 N in 50 kPa, which is
 * how far tissue about a needle is drawn along. A tip bends as its bevel says: after 8 cm in 10 to 50 kPa it is aside
 * by the same to 3 % with edges from 20 to 7 mm (5 mm in 10 kPa: 7 % less). Limits: lips of a cut that touch let a
 * needle through, but it does not go in through open ones, and is stopped as by a wall where a piece stands apart from
 * the next; where tissue was burnt away (sb_cut_ablate) nothing holds it, through burnt skin and out of the far side as
 * well, but friction comes and goes there by whole edges of the rod, and a way that is a part of one may not be seen; a
 * loose piece may stay on it when it is drawn out; the sb_cut that cut the body has to stay as long as needles do:
 * without it they are out of the tissue, as where others change the mesh; entry_slip is not read.
 */
typedef enum ndl_follow {
    NDL_REMESH = 0, /* the mesh follows: nodes are moved and made on the needle's line. tet4, def.slack > 0, no cuts; no
                     * two needles in one element */
    NDL_EMBED = 1   /* the mesh stays as it is: any elements but SB_CUSTOM, cut or not, several needles in an element */
} ndl_follow;

/* What a needle is made from. Start from ndl_default_needle_def(), set body, base and direction. */
typedef struct ndl_needle_def {
    sb_body *body;     /* with implicit steps; borrowed, destroyed after its needles. Its material, supports, loads and
                        * integrator are its own: see ndl_step */
    ndl_follow follow; /* default NDL_EMBED; the same for all needles of a body, and of a body whose states hold them */
    sb_vec3 base;      /* m: the sleeve's outlet, outside of the tissue */
    sb_vec3 direction; /* in which the needle leaves it, any length but 0 */
    sb_vec3 director;  /* m1 of the base, projected; default 0: any. A bevel bends the needle towards m2 = t x m1 */
    sb_real length;    /* m out of the sleeve at the start, > 0; default 0.05. The needle must be outside of the tissue,
                        * and outside of where its skin was before holes were burnt in it */
    sb_real edge_length;     /* m between nodes outside of the tissue, > 0; default 0: the mean of the tissue's edges */
    int capacity;            /* most nodes of the rod, >= 8; default 128 */
    ndl_rod_section section; /* default NDL_STYLET_18G */
    const ndl_rod_stiffness *stiffness;       /* overrules the section; default NULL */
    sb_real damping_stretch, damping_bending; /* s, as of ndl_rod_def; default 1e-4 */
    sb_vec3 gravity;                          /* m/s^2, on the needle; default 0 */
    ndl_bevel bevel;                          /* default a symmetric tip (NDL_BEVEL_CURVATURE with curvature 0) */
    sb_real bend_length;                      /* m of a pre-bent tip, >= 0 and < length; default 0 */
    sb_real bend_curvature;                   /* 1/m of it at rest, towards m2 */
    const ndl_friction *frictions; /* [friction_count] by region, or one for all; default NULL: none. Copied */
    int friction_count;
    const ndl_membrane *membranes; /* [membrane_count] or NULL; copied */
    int membrane_count;
    ndl_cutting cutting; /* default NULL: by the tables */
    void *cutting_user;
    sb_real entry_slip; /* where the skin is not flat the entry may be put on a node or edge of it, this share of the
                         * face's longest edge away at most (see ndl_remesh_def). In [0, 0.25].
                         * Default 0.25; 0: the entry stays where the needle met the skin, with flatter tets about
                         * it. Either way the shaft stays where it is, and goes with the entry at that distance: of
                         * 200 needles in ellipsoids, with 0.3 N to cut, the most was 0.55 N with 0.25, 0.45 N with
                         * 0 */
    int max_trials;     /* linear systems per Newton iteration with different states of friction, >= 1; default 10. The
                         * largest of all needles' holds */
    sb_allocator allocator; /* default malloc */
    unsigned cookie;        /* set by ndl_default_needle_def; a def made without it is refused */
} ndl_needle_def;

NDL_API ndl_needle_def ndl_default_needle_def(void);

/* A needle at rest, at its body from then on. *needle is untouched on failure: SB_ERROR_ARGUMENT (field named; a tip
 * that begins in the tissue; a membrane between regions that do not meet), _NOT_FINITE, _MATERIAL (section),
 * _UNSUPPORTED (NDL_MAX_NEEDLES are there; what the body is made of, see def.body), _MEMORY.
 *
 * From then on it is part of the body's saved state, hash and recording. A state that was saved with needles, in
 * mid-insertion too, is loaded (sb_body_state_load) into a body that has needles of the same defs, made in the same
 * order, wherever they are: it goes on to the last bit. A recording holds ndl_step and ndl_needle_move_base, and is
 * played on such a body. Make needles before a recording is started, and destroy them after it has been stopped: what
 * follows otherwise is refused when it is played. A `cutting` of your own is not saved: both must do the same. */
NDL_API sb_result ndl_needle_create(const ndl_needle_def *def, ndl_needle **needle, sb_error *error);
/* Takes it out of the tissue first. NULL is fine. */
NDL_API void ndl_needle_destroy(ndl_needle *needle);

/* ---- motion ---- */

/* What a needle is to do in a step; zeros: nothing. */
typedef struct ndl_command {
    sb_real insertion;        /* m/s fed out of the sleeve; negative: drawn back */
    sb_real twist;            /* rad/s of the base about its axis */
    sb_vec3 velocity;         /* m/s of the sleeve's outlet */
    sb_vec3 angular_velocity; /* rad/s of the sleeve about its outlet; its part along the axis adds to twist */
} ndl_command;

/* In the next step the sleeve goes to `base` (m), looks along `direction` and turns its m1 into `director` (any length
 * but 0; the short way), beside what the command says: for sleeves that are tracked. director 0: turned only as the
 * direction turns. SB_ERROR_ARGUMENT, _NOT_FINITE change nothing. */
NDL_API sb_result ndl_needle_move_base(ndl_needle *needle, sb_vec3 base, sb_vec3 direction, sb_vec3 director);

/* What a step did, over all needles and substeps. */
typedef struct ndl_step_info {
    int substeps;      /* a step is cut where a tip would go further than about half an edge of the tissue, where it
                        * comes into a membrane or out of it, and where no solution was found: into a fourth, a 16th,
                        * a 64th of that, and longer ones again behind it */
    sb_real peak_base; /* N, largest force on a base at the end of a substep: what a membrane asked for that gave way
                        * within the step */
    int trials;        /* largest number of a substep */
    int consistent;    /* 1: friction states came out as they were taken, in all substeps; 0: in one they were not found
                        * in max_trials, but what is held is within 2 % of what friction and tips can hold */
    int iterations;    /* of conjugate gradients, in all */
    int capped;        /* 1: their cap was hit */
    sb_real residual;  /* largest of a substep */
    int static_nodes, dynamic_nodes; /* at the end */
    int operations;                  /* of the remesher */
    sb_real worst_quality;           /* of tets about the tips; 1: none */
    int blocked;         /* needles whose tip is held: it has come near the skin from inside, or the mesh could not
                          * follow it (no operation left sound tets, no memory); then it tries again later */
    int torn;            /* needles that tore out of the skin, because nothing else could be computed: less than half an
                          * edge deep, or, with NDL_REMESH, where the mesh has left the shaft so far beside its path
                          * that no step, however short, goes on from there. With NDL_EMBED they are held again,
                          * without a force at first, once they are half an edge deep: from where the shaft goes in
                          * through the skin. With NDL_REMESH they come in again when their tips cross the skin anew,
                          * from outside */
    int limited;         /* needles that were fed less than asked for: the sleeve holds the rest, or capacity is used */
    int coarse;          /* needles with NDL_REMESH in tissue so soft that it, not the bevel, sets how far they bend
                          * (curvature times lam beyond the lag, see steer.h): their way then depends on the mesh, 0.82
                          * to 1.56 times the bend of NDL_EMBED. Do not trust it; take NDL_EMBED */
    sb_step_info body;   /* of the last substep */
    double seconds_body; /* with the body's clock, else 0: forces, matrix and preconditioner of the body, */
    double seconds_couple; /* needles' matrices and all trials, */
    double seconds_needle; /* sleeves, frames and nodes of the needles, */
    double seconds_remesh; /* remeshing with its changes of the matrix, */
    double seconds_total;  /* and the whole call */
} ndl_step_info;

/* Advances a body and all its needles by dt (s, > 0): in place of sb_body_step, which moves the body without them.
 * needles: [count], each needle of the body once, in any order; commands: [count] beside them, or NULL: zeros
 * info may be NULL. On failure all is as before: SB_ERROR_ARGUMENT (needle missing or doubled; a command that would
 * take over 1000 substeps), _NOT_FINITE (command named); SB_ERROR_UNSUPPORTED, a needle is at a node that constraints
 * eliminate; with NDL_REMESH, two needles would share an element (which are, is said), or the body is cut
 * (sb_cut_triangles);
 * SB_ERROR_DIVERGED (node named); SB_ERROR_INVERTED (element named); SB_ERROR_MEMORY; SB_ERROR_STATE, another change of
 * the body is open. Where the mesh has changed within a step that fails and there is no memory to take that back
 * either, SB_ERROR_MEMORY says so: body and needles are then between two states until the next call of ndl_step or
 * ndl_needle_create, which takes the step back first, or until a saved state is loaded. Steps that do without memory
 * they asked for (info->blocked) are not repeated by a recording that has it.
 *
 * A step is divided where a tip comes to an edge of a membrane, and would go past it by more than a quarter of the
 * membrane's thickness, or a command is fast, and where it fails as a whole: the rod would fold, tissue would turn
 * inside out, or of hyperelastic tissue max_newton iterations do not bring it to where the needle has gone (what is
 * read of a needle is never the force of that gap). Supports and tools of an sb_contact go evenly over its parts, and
 * what tools feel, as a blade's forces, is of the step that was made, whatever was tried before. In parts cut short by
 * a membrane a tool that just comes to the tissue feels the parts' shorter time: up to 8 % of the force that it has
 * later (measured in 8 scenes).
 *
 * The linear systems of the body's own step are solved together with needles and friction (see couple.h), to its
 * tolerance: one where it is linearised (max_newton 1), otherwise until body, needles and friction balance. Needles are
 * stepped by implicit Euler, the body by its own integrator. SB_EULER and SB_GENERALISED_ALPHA with spectral_radius 0,
 * which is of second order, let the force on the base settle at once when the needle stops; others do not damp the
 * motion that friction leaves in the tissue. Measured (nitinol needle 3.5 cm deep in 50 kPa, push 1.20 N, steps of 20
 * ms): half a second after the stop the force stays within 1e-4 N with the two; with SB_NEWMARK it goes on ringing by 5
 * mN, without damping_stiffness by 0.34 N; with spectral_radius 0.8 it jumps by up to 0.45 N from step to step while
 * the needle moves (0.007 N with 0).
 *
 * Steps of a millisecond, as hands ask for, take some 0.6 of the time with NDL_EMBED in a body of tet4 that keeps its
 * tangent (sb_body_keep_tangent), and the force on the base stays the same to a millionth. */
NDL_API sb_result ndl_step(sb_body *body, ndl_needle *const *needles, int count, sb_real dt,
                           const ndl_command *commands, ndl_step_info *info, sb_error *error);

/* ---- readings: no allocation ---- */

/* The rod: positions, frames, curvature; nodes 0 and 1 are in the sleeve, node 1 at its outlet. Valid until the needle
 * is destroyed, its arrays until the next step. */
NDL_API const ndl_rod *ndl_needle_rod(const ndl_needle *needle);
/* Where the tip is and looks, for ndl_steer_update; it bends towards frame.m2. With NDL_BEVEL_CURVATURE t is where the
 * path goes on; the rod's last edge, a chord, lags behind by half of what it bends, and more after a turn. */
NDL_API ndl_tip_pose ndl_needle_tip(const ndl_needle *needle);
/* What the sleeve exerts on the needle at its outlet: force (N) and torque (N m) about it, in the last step. What a
 * hand feels is the opposite. Either may be NULL. */
NDL_API void ndl_needle_base_wrench(const ndl_needle *needle, sb_vec3 *force, sb_vec3 *torque);
/* First node of the rod in the tissue; the rod's node_count when it is outside. With NDL_EMBED the edge before it goes
 * in through the skin, and is held there, too: that node has a contact state and force. */
NDL_API int ndl_needle_entry(const ndl_needle *needle);
/* Tissue node that a rod node is at; -1: none, as with NDL_EMBED. */
NDL_API int ndl_needle_body_node(const ndl_needle *needle, int node);
/* What follows the tips of all needles of its body, for readings: ndl_remesh_quality, _is_original, _nodes ...; gone
 * with the body's last needle. NULL with NDL_EMBED. */
NDL_API const ndl_remesh *ndl_needle_remesh(const ndl_needle *needle);
NDL_API ndl_contact ndl_needle_contact(const ndl_needle *needle, int node);
/* Force (N) of the tissue on a node in the last step. */
NDL_API sb_vec3 ndl_needle_contact_force(const ndl_needle *needle, int node);
/* Length of shaft in the tissue, in holes that were burnt in it, and out of one on its far side (m), and fed since
 * creation. */
NDL_API sb_real ndl_needle_depth(const ndl_needle *needle);
NDL_API sb_real ndl_needle_fed(const ndl_needle *needle);
/* How far the tip went through the tissue in the last step (m, along the tip; negative: back). */
NDL_API sb_real ndl_needle_advance(const ndl_needle *needle);
/* Force (N) that would let the tip go forward now; SB_REAL_MAX while it is held. */
NDL_API sb_real ndl_needle_cutting(const ndl_needle *needle);
/* Material point (m) of the tip; 0 when the needle is outside, else 1. */
NDL_API int ndl_needle_tip_material(const ndl_needle *needle, sb_vec3 *X);

#endif /* NDL_NEEDLE_H */
