/* steer: where a bevelled needle goes, plans of helices to a target past obstacles, a controller that follows them, and
 * one that pushes tissue so that a target moves onto a straight needle's path. Floor 6.
 *
 * A needle with a bevelled tip that is pushed into tissue bends towards one side; turning its base turns that side.
 * With a steady turn the tip draws a helix, with none a circle. All here works on the tip's pose alone: it needs no
 * tissue and no rod, only the curvature of the circles, which is measured (see ndl_bevel). Lengths in m, angles in rad.
 *
 *     ndl_steer_def def = ndl_default_steer_def(10, 0.15);   (radius 10 cm, at most 15 cm deep)
 *     ndl_steer steer;
 *     ndl_steer_command command;
 *     if (ndl_steer_begin(&def, &steer, &error) != SB_OK) ...
 *     do {                                                   (sense the tip and the target, then:)
 *         ndl_steer_update(&steer, &tip, target, &command);
 *         (insert command.insertion, turn the base by command.turn)
 *     } while (command.status == NDL_STEER_GOING);
 *
 * Nothing here allocates; calls on different objects are independent of each other. Sources: Webster et al. 2006
 * (nonholonomic model), Hauser et al. 2009 (feedback on helical paths), Torabi et al. 2009 (single-point manipulation),
 * Chentanez 2010, 10.1 and 12.2. */
#ifndef NDL_STEER_H
#define NDL_STEER_H

#include "../softbody/geometry/surface.h"
#include "api.h"
#include "rod.h"

/* ---- where a tip goes ---- */

/* Position (m) of a tip and its frame: t points ahead, and the needle bends towards m2. */
typedef struct ndl_tip_pose {
    sb_vec3 position;
    ndl_frame frame; /* orthonormal and right-handed to 1e-3; used made exact */
} ndl_tip_pose;

/* The pose after `length` (m, either sign) of insertion at a steady twist (rad of turn per m of insertion, about t),
 * for a tip that bends with `curvature` (1/m). Exact for any size, also for 0. Pure turning is ndl_tip_turn. */
NDL_API ndl_tip_pose ndl_helix_pose(const ndl_tip_pose *start, sb_real curvature, sb_real twist, sb_real length);
/* The pose turned in place by `angle` about t. */
NDL_API ndl_tip_pose ndl_tip_turn(const ndl_tip_pose *start, sb_real angle);
/* Radius (m) of that helix, k/(k^2 + w^2), and its way ahead per turn, 2 pi |w|/(k^2 + w^2); k and w not both 0. */
NDL_API sb_real ndl_helix_radius(sb_real curvature, sb_real twist);
NDL_API sb_real ndl_helix_pitch(sb_real curvature, sb_real twist);

/* ---- what a bevel does in tissue ----
 * The way of a tip turns by a curvature as it goes on, towards m2. A needle (needle.h) that follows it in rigid tissue
 * goes in circles of that curvature. Soft tissue gives way, and the shaft bends over a length lam = (4 EI / k)^(1/4), k
 * its stiffness across (N/m^2): the way leaves the shaft's direction by an angle `lag` at most, which gives a curvature
 * of lag/lam there, whatever the mesh (with NDL_REMESH and NDL_BEVEL_CURVATURE the mesh's edges set that limit). A
 * turning bevel draws the helix of its turn (ndl_helix_pose), also from the skin on and with a turn of radians in a
 * step: its axis leaves the straight way by curvature/twist.
 *
 * For tips in meshes of your own: one that advances by d along t has its material point put aside by an offset h
 * against which the needle then bends: X <- X(x_tip) + F^-1 h m2. */

typedef enum ndl_bevel_law {
    NDL_BEVEL_ANGLE = 1,    /* the curvature is 2 tan(angle)/guide, the lag the angle. h = d tan(angle) */
    NDL_BEVEL_CURVATURE = 2 /* h = d tan(curvature (l + d)/2): circles in rigid tissue for any edge length l and step d;
                             * softer tissue gives less */
} ndl_bevel_law;

/* Of a needle, start from ndl_default_needle_def. */
typedef struct ndl_bevel {
    ndl_bevel_law law;
    sb_real angle;     /* rad, |angle| < 1.5; for NDL_BEVEL_ANGLE: between what the tip cuts and the shaft behind it. An
                        * effective angle of few degrees, not the ground one */
    sb_real curvature; /* 1/m, for NDL_BEVEL_CURVATURE. Measured: radii of 5 to 50 cm are usual; 0: symmetric tip */
    sb_real guide;     /* m, > 0, for NDL_BEVEL_ANGLE of a needle: length of shaft that guides the tip in rigid tissue.
                        * A needle's default 0.005 */
    sb_real lag;       /* rad, > 0, for NDL_BEVEL_CURVATURE of a needle. It can be measured in one soft gel: curvature
                        * times lam. A needle's default 0.1 */
} ndl_bevel;

/* Offset h (m) for an advance d (m) of a tip whose last edge is edge_length (m) long; 0 for d <= 0 (retraction).
 * SB_ERROR_ARGUMENT (law, angle, edge_length <= 0, or an edge too long for the circle: |curvature| (l + d) > 2) and
 * SB_ERROR_NOT_FINITE leave *offset untouched. */
NDL_API sb_result ndl_bevel_offset(const ndl_bevel *bevel, sb_real advance, sb_real edge_length, sb_real *offset);
/* The material displacement F^-1 (offset m2) of the tip's material point; F is the deformation gradient about the tip,
 * averaged by volume over the tip's star (that of one element jumps). SB_ERROR_INVERTED when det F <= 0,
 * SB_ERROR_NOT_FINITE; *shift is then untouched. */
NDL_API sb_result ndl_bevel_shift(sb_real offset, sb_vec3 m2, const sb_mat3 *deformation, sb_vec3 *shift);
/* Curvature (1/m) that a bevel gives in rigid tissue, with edges and advances as given (see above for errors). That of
 * a needle has advance 0, edge_length the bevel's guide. */
NDL_API sb_result ndl_bevel_curvature(const ndl_bevel *bevel, sb_real advance, sb_real edge_length, sb_real *curvature);

/* ---- obstacles ---- */

typedef enum ndl_obstacle_kind {
    NDL_OBSTACLE_SPHERE = 1,   /* centre a */
    NDL_OBSTACLE_CAPSULE = 2,  /* all within radius of the segment from a to b */
    NDL_OBSTACLE_CYLINDER = 3, /* flat ends at a and b, apart */
    NDL_OBSTACLE_SHAPE = 4     /* inside of a surface or a function. To stay inside an organ, negate its distance */
} ndl_obstacle_kind;

typedef struct ndl_obstacle {
    ndl_obstacle_kind kind;
    sb_vec3 a, b;          /* m */
    sb_real radius;        /* m, > 0 */
    const sb_shape *shape; /* for NDL_OBSTACLE_SHAPE, borrowed; a function needs its max_slope */
} ndl_obstacle;

/* Distance (m) of a point from an obstacle, negative inside; for functions of slopes up to max_slope their value
 * divided by it: never more than the distance. SB_REAL_MAX for NULL or a kind that is none; what
 * else is wrong with an obstacle ndl_plan_make says. */
NDL_API sb_real ndl_obstacle_distance(const ndl_obstacle *obstacle, sb_vec3 point);

/* ---- plans ---- */

enum { NDL_PLAN_PIECES = 3 }; /* most pieces of a plan */

/* First a turn in place, then an insertion at a steady twist. */
typedef struct ndl_plan_piece {
    sb_real turn;   /* rad, in [-pi, pi] */
    sb_real twist;  /* rad/m */
    sb_real length; /* m, >= 0 */
} ndl_plan_piece;

typedef enum ndl_plan_outcome {
    NDL_PLAN_REACHES = 1, /* ends within the tolerance of the target, clear of obstacles */
    NDL_PLAN_SHORT = 2,   /* clear of obstacles, but ends farther off: `distance` */
    NDL_PLAN_BLOCKED = 3  /* the tip is in an obstacle already: no pieces */
} ndl_plan_outcome;

typedef struct ndl_plan {
    ndl_plan_outcome outcome;
    int piece_count;
    ndl_plan_piece pieces[NDL_PLAN_PIECES];
    sb_real length;    /* m, of all pieces */
    sb_real distance;  /* m, from the end to the target */
    sb_real bound;     /* m: without obstacles no plan of one piece ends nearer than this; proven, see ndl_plan_make */
    sb_real clearance; /* m: no obstacle is nearer to the path, proven; SB_REAL_MAX without obstacles */
    int boxes;         /* boxes looked at by branch and bound: a measure of the work; 0 when not needed */
} ndl_plan;

/* What a plan may use. Start from ndl_default_plan_def. */
typedef struct ndl_plan_def {
    sb_real curvature;  /* 1/m, > 0 */
    sb_real max_length; /* m of insertion, > 0 */
    sb_real max_twist;  /* rad/m, >= 0; default 50 times the curvature */
    int turn;           /* 1 (default): the base may be turned with no insertion, at the start of each piece: every
                         * point the needle can bend to is met. 0: steady twist only, as in Hauser et al.: helices
                         * then leave gaps that are up to pi k/w^2 wide about a twist of w */
    sb_real tolerance;  /* m, in [1e-6 max_length, max_length]; default 1/1000 of the radius 1/curvature */
    int max_boxes;      /* most boxes of one search, >= 1; default 5000. When they run out `bound` is lower */
    const ndl_obstacle *obstacles; /* [obstacle_count], borrowed; default none. For a controller they may be moved, but
                                    * not added to, between updates */
    int obstacle_count;
    sb_real clearance; /* m from obstacles, >= 0: half the needle's diameter, and margin; default 1/200 of the
                        * radius */
    int max_pieces;    /* 1 ... NDL_PLAN_PIECES; default 3. More than one is used only where obstacles ask for it */
    int samples;       /* paths tried past obstacles for each number of pieces, >= 1; default 400 */
    unsigned cookie;   /* set by ndl_default_plan_def; a def made without it is refused */
} ndl_plan_def;

NDL_API ndl_plan_def ndl_default_plan_def(sb_real curvature, sb_real max_length);

/* The helix from the tip that ends nearest to the target (m), to the tolerance: branch and bound over length and twist,
 * after a descent from a few starts which mostly settles it. Where obstacles are in its way, sequences of pieces: the
 * first ones sampled and improved, the last one aimed at the target; of those that reach the target one that is short
 * and has room on both sides. A path ends where it is nearest: it is never inserted further. A tip nearer to an
 * obstacle than def.clearance keeps nine tenths of the distance it has. SB_OK with any outcome. SB_ERROR_ARGUMENT,
 * _NOT_FINITE (field or obstacle named) leave *plan untouched. 2 us where turning gets there, else about 0.3 ms (1 ms
 * where max_boxes run out), 1 to 10 ms past obstacles (without turning to 0.1 s). Deterministic to the bit. */
NDL_API sb_result ndl_plan_make(const ndl_plan_def *def, const ndl_tip_pose *tip, sb_vec3 target, ndl_plan *plan,
                                sb_error *error);
/* The pose `length` (m) along a plan, in [0, plan->length] (clamped), from the tip it was made for; at 0
 * with its first turn made. */
NDL_API ndl_tip_pose ndl_plan_pose(const ndl_plan *plan, sb_real curvature, const ndl_tip_pose *tip, sb_real length);

/* ---- feedback ---- */

typedef enum ndl_steer_status {
    NDL_STEER_GOING = 0,
    NDL_STEER_REACHED = 1, /* within def.reach of the target, and no nearer place ahead */
    NDL_STEER_CLOSEST = 2, /* can get no closer, but is not within def.reach */
    NDL_STEER_LIMIT = 3,   /* max_length is used up, or def.max_updates */
    NDL_STEER_BLOCKED = 4  /* no way on clear of the obstacles was found */
} ndl_steer_status;

/* What to do until the next update. Divide by the time step for speeds. */
typedef struct ndl_steer_command {
    ndl_steer_status status;
    sb_real insertion; /* m, >= 0; 0 when turning in place and when not going */
    sb_real turn;      /* rad to turn the base by, about t */
    sb_real distance;  /* m, from the sensed tip to the target */
    sb_real expected;  /* m, from the end of the present plan to the target */
} ndl_steer_command;

/* Start from ndl_default_steer_def. */
typedef struct ndl_steer_def {
    ndl_plan_def plan;  /* plan.max_length is that of the whole insertion */
    sb_real reserve;    /* share of the curvature, in [0, 1), that plans do not use, so that a needle that bends less
                         * than it should, or tissue that gives way, can be made up for; default 0.2 */
    sb_real step;       /* m of insertion per update, > 0; default 1/100 of the radius */
    sb_real max_turn;   /* rad per update, > 0; default 1 */
    sb_real turn_gain;  /* share of the tip's error in roll made good per update, in (0, 1]; default 0.5. Lower where
                         * the tip follows the base late */
    sb_real turn_first; /* rad: insertion waits while the roll is further off than this; default 0.3 */
    int max_wait;       /* updates it waits at a stretch, >= 0; default 40. Then it goes on */
    sb_real reach;      /* m, > 0: what counts as reached; default 1/100 of the radius */
    int max_updates;    /* >= 1; default 10000 */
    sb_real learn;      /* m of insertion, >= 0, over which the tip's way is averaged to learn where it really goes
                         * (see ndl_steer_update). Default 12/100 of the radius; shorter where the sensed position is
                         * good, longer where it is noisy; 0: the tip is taken to go where it looks, with the given
                         * curvature */
    unsigned cookie;    /* set by ndl_default_steer_def */
} ndl_steer_def;

/* curvature and max_length as in ndl_default_plan_def. */
NDL_API ndl_steer_def ndl_default_steer_def(sb_real curvature, sb_real max_length);

/* A controller: plain data, may be copied (a copy is its saved state). Fields are read-only. */
typedef struct ndl_steer {
    ndl_steer_def def;
    ndl_steer_status status;
    sb_real inserted;   /* m commanded */
    int updates, plans; /* plans: how often a way past the obstacles was searched */
    int waited;         /* updates of the present wait */
    int next_search;    /* the update from which a better way is looked for again, while the present one is clear */
    int waypoint_count;
    sb_vec3 waypoints[NDL_PLAN_PIECES - 1]; /* m, where the pieces before the last one end */
    ndl_plan plan;                          /* from the last sensed tip */
    sb_real curvature;                      /* 1/m: def.plan.curvature, as measured since: between half of it and all */
    sb_vec3 drift;                          /* the tip's way less where it looks, across: small angles (rad) */
    /* internal: what it is learned from */
    ndl_tip_pose tip; /* the last one sensed */
    sb_vec3 way;      /* unit: where it was found to go */
    sb_vec3 first;    /* t of the first one */
    sb_real advance;  /* m: what was inserted since */
    sb_real weight;   /* m^2: that of the present estimate of the curvature */
    int bends;        /* 1: the tip has been seen to bend, so it is in tissue */
} ndl_steer;

/* SB_ERROR_ARGUMENT and SB_ERROR_NOT_FINITE leave *steer untouched. */
NDL_API sb_result ndl_steer_begin(const ndl_steer_def *def, ndl_steer *steer, sb_error *error);
/* One round: the plan from the sensed tip to the sensed target (m; tissue moves it), and what to do. Pieces of a plan
 * past obstacles are aimed anew at where they were to end, and the way is searched anew when that is no longer clear.
 * The controller learns from the sensed tips, by averages that forget: how far their way leans from where they look
 * (soft tissue gives way sideways under a needle that bends) over def.learn of insertion, and with what curvature their
 * way turns over twice that. Plans begin along the way so found and use that curvature, which is never taken for more
 * than the given one or less than half of it, less def.reserve. It is only measured once the tip has turned by 0.05
 * rad: before, it may be in air.
 * Once the status is not GOING it stays and nothing more is commanded; ndl_steer_begin starts over. SB_ERROR_NOT_FINITE
 * and SB_ERROR_ARGUMENT (a frame that is none) change nothing. Cost: see ndl_plan_make. */
NDL_API sb_result ndl_steer_update(ndl_steer *steer, const ndl_tip_pose *tip, sb_vec3 target,
                                   ndl_steer_command *command);

/* ---- pushing the tissue ---- */

/* Start from ndl_default_push_def, set compliance, line and max_force. The gains have no unit but that of time: the
 * compliance turns errors into forces. */
typedef struct ndl_push_def {
    sb_mat3 compliance;     /* m/N: displacement of the point of interest per force of the manipulator. An estimate will
                             * do: off by a factor below 2, or 45 degrees */
    sb_vec3 line_point;     /* m, on the needle's path */
    sb_vec3 line_direction; /* any length but 0 */
    sb_real clear_radius;   /* m; 0 (default): move the point onto the path. > 0: out of a cylinder of this radius
                             * about it (an obstacle) */
    sb_vec3 direction;      /* in which the manipulator pushes, any length but 0; default 0: any direction (a grip) */
    sb_real cone;           /* rad, in [0, pi/2]: how far the force may lean from `direction`; default 0.5 */
    sb_real max_force;      /* N, > 0 */
    sb_real proportional;   /* >= 0, default 0.3. Tissue that follows at once needs less than 1 */
    sb_real integral;       /* 1/s, >= 0; default 1 */
    sb_real max_rate;       /* N/s, > 0; default SB_REAL_MAX */
    sb_real tolerance;      /* m, > 0: within it the push has arrived; default 5e-4 */
    unsigned cookie;        /* set by ndl_default_push_def */
} ndl_push_def;

NDL_API ndl_push_def ndl_default_push_def(void);

/* A PI controller: plain data, may be copied. Fields are read-only. */
typedef struct ndl_push {
    ndl_push_def def; /* directions made unit vectors */
    sb_vec3 integral; /* m: the integral part of the displacement asked for */
    sb_vec3 force;    /* N */
    sb_vec3 error;    /* m: way that the point has still to go, across the path; 0 when there */
    int arrived;      /* the last error was within the tolerance */
    int limited;      /* the force asked for was beyond the cone, max_force or max_rate */
} ndl_push;

/* SB_ERROR_ARGUMENT (field named; a compliance that moves nothing across the path), _NOT_FINITE leave *push untouched.
 * */
NDL_API sb_result ndl_push_begin(const ndl_push_def *def, ndl_push *push, sb_error *error);
/* From the sensed point of interest (m) after another dt (s, > 0) to the manipulator's force (N): the one within cone
 * and max_force that comes nearest to displacing the point by proportional error + integral of the error. While a limit
 * holds, the integral grows only where that leads away from the limit. SB_ERROR_ARGUMENT, _NOT_FINITE change nothing.
 * */
NDL_API sb_result ndl_push_update(ndl_push *push, sb_vec3 point, sb_real dt, sb_vec3 *force);

/* The cheapest of `count` places to push at: def with each compliance and direction (directions may be NULL: def's) in
 * turn, for a point of interest at `point`. *best: the index of the one that needs the least force, or, where none
 * brings the point all the way, of the one that leaves the least; *force (N) and *left (m, may both be NULL): that
 * force and what it leaves. SB_ERROR_ARGUMENT and _NOT_FINITE leave all untouched. */
NDL_API sb_result ndl_push_choose(const ndl_push_def *def, const sb_mat3 *compliances, const sb_vec3 *directions,
                                  int count, sb_vec3 point, int *best, sb_vec3 *force, sb_real *left, sb_error *error);

#endif /* NDL_STEER_H */
