/* register.h 0.3.0: matching an organ model to what the surgeon sees
 * MIT or public domain, as you like; the texts are at the end of this file.
 * Generated from src/register/: edit there, then run `make headers`. */
#include "softbody.h"

/* ==== src/register/register_doc.h ==== */
/*
 * register.h - matching an organ model to what the surgeon sees, in one header on top of softbody.h.
 *
 * HOW TO INCLUDE
 *
 * In one C or C++ file, which is the one that holds softbody.h's implementation:
 *
 *     #define SB_IMPLEMENTATION
 *     #define REG_IMPLEMENTATION
 *     #include "register.h"
 *
 * and in all others only the last line; it includes softbody.h. Both headers come from one release and lie in one
 * folder. Link with -lm, optimise (-O2 or -O3).
 *
 * OPTIONS are softbody.h's. SB_REAL: exported names of a float build end in _f32. SB_STATIC makes this header static,
 * too; REG_STATIC makes only this one so.
 *
 * LICENCE
 *
 * MIT or public domain, as you like; the texts are at the end of this file.
 */

/* ==== src/register/../softbody/begin.h ==== */
/* begin: compiler settings for the library's own code; end.h gives the caller's back.
 *
 * A product and a sum may not be contracted into one rounding (fused multiply-add), or results would depend on the
 * compiler and the processor. Compilers differ in how a header can say so:
 * - clang: by the standard pragma; -ffp-contract=fast overrules it.
 * - gcc knows the standard pragma in no release yet, and contracts unless told -std=c99 or -ffp-contract=off. Its
 *   own pragma stops that, but code under it is not inlined into code outside, so it stands only where the target
 *   has fused instructions and the language mode lets gcc use them. The system headers come first: their inline
 *   functions are the caller's business.
 * - MSVC: by its own pragma, in the file that holds the implementation. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#if !defined(__STRICT_ANSI__) && (defined(__FP_FAST_FMA) || defined(__FP_FAST_FMAF))
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#if defined(SB_IMPLEMENTATION)
#include <errno.h>
#include <float.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#endif
#pragma GCC push_options
#pragma GCC optimize("fp-contract=off")
#endif
#elif defined(_MSC_VER) && defined(SB_IMPLEMENTATION)
#pragma fp_contract(off)
#endif

#ifndef REGISTER_H
#define REGISTER_H

/* ==== src/register/names.h ==== */
/* names: the exported names of a float build end in _f32, so that a float caller and a double object do
 * not link. Written by src/amalgamate.c from the declarations: do not edit. */
#ifndef REGI_NAMES_H
#define REGI_NAMES_H

#if defined(SB_REAL)
#define REGI_NAMES_PASTE_(a, b) a##b
#define REGI_NAMES_PASTE(a, b) REGI_NAMES_PASTE_(a, b)
#define REGI_NAMES_OF_double 0
#define REGI_NAMES_OF_float 1
#if REGI_NAMES_PASTE(REGI_NAMES_OF_, SB_REAL)
#define reg_rigid_identity reg_rigid_identity_f32
#define reg_rigid_apply reg_rigid_apply_f32
#define reg_rigid_compose reg_rigid_compose_f32
#define reg_rigid_inverse reg_rigid_inverse_f32
#define reg_rigid_angle reg_rigid_angle_f32
#define reg_rigid_fit reg_rigid_fit_f32
#define reg_kdtree_create reg_kdtree_create_f32
#define reg_kdtree_destroy reg_kdtree_destroy_f32
#define reg_kdtree_count reg_kdtree_count_f32
#define reg_kdtree_nearest reg_kdtree_nearest_f32
#define reg_kdtree_k_nearest reg_kdtree_k_nearest_f32
#define reg_kdtree_within reg_kdtree_within_f32
#define reg_default_field_def reg_default_field_def_f32
#define reg_field_create reg_field_create_f32
#define reg_field_destroy reg_field_destroy_f32
#define reg_field_closest reg_field_closest_f32
#define reg_field_along reg_field_along_f32
#define reg_field_at reg_field_at_f32
#define reg_field_bounds reg_field_bounds_f32
#define reg_field_sweeps reg_field_sweeps_f32
#define reg_default_match_def reg_default_match_def_f32
#define reg_match_create reg_match_create_f32
#define reg_match_destroy reg_match_destroy_f32
#define reg_match_step reg_match_step_f32
#define reg_match_run reg_match_run_f32
#define reg_match_restart reg_match_restart_f32
#define reg_match_move_landmarks reg_match_move_landmarks_f32
#define reg_match_landmarks reg_match_landmarks_f32
#define reg_match_body reg_match_body_f32
#define reg_match_get_info reg_match_get_info_f32
#define reg_match_sample_count reg_match_sample_count_f32
#define reg_match_get_sample reg_match_get_sample_f32
#endif
#endif

#endif /* REGI_NAMES_H */

/* ==== src/register/api.h ==== */
/* api: version and linkage of register.h. Results, errors, allocator, vectors and the scalar type are softbody.h's. */
#ifndef REG_API_H
#define REG_API_H


#define REG_VERSION_MAJOR 0
#define REG_VERSION_MINOR 3
#define REG_VERSION_PATCH 0
#define REG_VERSION_STRING "0.3.0"

#if REG_VERSION_MAJOR != SB_VERSION_MAJOR || REG_VERSION_MINOR != SB_VERSION_MINOR || \
    REG_VERSION_PATCH != SB_VERSION_PATCH
#error "register.h and softbody.h are of different versions: take both from one release"
#endif
#if defined(REG_IMPLEMENTATION) && !defined(SB_IMPLEMENTATION)
#error "register.h: define REG_IMPLEMENTATION in the file that defines SB_IMPLEMENTATION"
#endif

/* REG_API: public functions; static under SB_STATIC or REG_STATIC. REGI_API: internal functions; static in the shipped
 * header, extern when the rooms are compiled apart. */
#if defined(SB_STATIC) || defined(REG_STATIC)
#define REG_API static SBI_UNUSED
#elif defined(__cplusplus)
#define REG_API extern "C"
#else
#define REG_API extern
#endif
#if defined(SB_SPLIT_BUILD)
#define REGI_API extern
#else
#define REGI_API static SBI_UNUSED
#endif

#endif /* REG_API_H */

/* ==== src/register/rigid.h ==== */
/* rigid: rigid motions, and the one that brings points nearest to their partners. Floor 1. */
#ifndef REG_RIGID_H
#define REG_RIGID_H


/* x -> rotation x + translation. */
typedef struct reg_rigid {
    sb_mat3 rotation;    /* orthonormal, determinant 1 */
    sb_vec3 translation; /* m */
} reg_rigid;

REG_API reg_rigid reg_rigid_identity(void);
REG_API sb_vec3 reg_rigid_apply(const reg_rigid *motion, sb_vec3 point);
/* First `first`, then `then`. */
REG_API reg_rigid reg_rigid_compose(const reg_rigid *then, const reg_rigid *first);
REG_API reg_rigid reg_rigid_inverse(const reg_rigid *motion);
/* Angle (rad, in [0, pi]) of the rotation. */
REG_API sb_real reg_rigid_angle(const reg_rigid *motion);

/* The motion that minimises sum w |motion(from) - to|^2 (Kabsch 1976, never a reflection).
 * from, to: [count] partners (m); weights: [count] >= 0, not all 0, or NULL: all 1; count >= 1. Where the points leave
 * the rotation open (all in one line or one point) it is one of the best. SB_ERROR_ARGUMENT, _NOT_FINITE (index named)
 * leave *motion untouched. No allocation. */
REG_API sb_result reg_rigid_fit(const sb_vec3 *from, const sb_vec3 *to, const sb_real *weights, int count,
                                reg_rigid *motion, sb_error *error);

#endif /* REG_RIGID_H */

/* ==== src/register/kdtree.h ==== */
/* kdtree: nearest points of a cloud. Floor 2.
 *
 * A balanced tree over a copy of the points, eight to a leaf and side by side there; every node knows the smallest
 * boxes around its halves. Queries allocate and change nothing, so any number of threads may ask at once, and give the
 * same answer whatever the tree looks like: of points equally far, the one with the smallest index counts as nearer. */
#ifndef REG_KDTREE_H
#define REG_KDTREE_H


typedef struct reg_kdtree reg_kdtree;

/* Makes a tree of points[count] (m; count >= 1, points may coincide), which are copied. One block of memory from
 * `allocator` (NULL: malloc; at most 80 bytes per point) and scratch that goes back.
 * O(count log count). SB_ERROR_ARGUMENT (null pointer, no points, or a coordinate whose square would overflow),
 * _NOT_FINITE (error->node: the point), _MEMORY; then *tree is untouched. */
REG_API sb_result reg_kdtree_create(const sb_vec3 *points, int count, const sb_allocator *allocator, reg_kdtree **tree,
                                    sb_error *error);
REG_API void reg_kdtree_destroy(reg_kdtree *tree); /* accepts NULL */
/* Number of its points; 0 for NULL. */
REG_API int reg_kdtree_count(const reg_kdtree *tree);

/* Index of the point nearest to `point` among those at most `within` (m; SB_REAL_MAX: any) away, and its squared
 * distance (m^2) in *squared (may be NULL). -1 (nothing written) when there is none, the tree is NULL, or an argument
 * is not finite or negative. O(log count) for points near the cloud. */
REG_API int reg_kdtree_nearest(const reg_kdtree *tree, sb_vec3 point, sb_real within, sb_real *squared);

/* The k nearest points, nearest first: indices[k] and squared distances squared[k] (m^2; both needed). Returns how many
 * were found: k, or all points when there are fewer; 0 for k < 1, NULL, or a point that is not finite. */
REG_API int reg_kdtree_k_nearest(const reg_kdtree *tree, sb_vec3 point, int k, int *indices, sb_real *squared);

/* All points at most `radius` (m) away: returns how many, of which the first `room` are written to indices[room] (may
 * be NULL with room 0: only count). In no particular, yet always the same order. 0 as above. */
REG_API int reg_kdtree_within(const reg_kdtree *tree, sb_vec3 point, sb_real radius, int *indices, int room);


#endif /* REG_KDTREE_H */

/* ==== src/register/field.h ==== */
/* field: the potential about a target that matching slides down: its distance, or Laplace's. Floor 3. */
#ifndef REG_FIELD_H
#define REG_FIELD_H


typedef enum reg_field_kind {
    REG_FIELD_DISTANCE = 0, /* phi: distance to the target (m); exact everywhere, nothing is computed beforehand */
    REG_FIELD_LAPLACE = 1   /* Lap phi = 0 in a box, phi = 0 on the target and the distance on the box: the field of a
                             * charged conductor. Inside a closed target it is 0 */
} reg_field_kind;

/* What a field is made from; start from reg_default_field_def(). The target is a surface or a cloud. */
typedef struct reg_field_def {
    reg_field_kind kind;      /* default REG_FIELD_DISTANCE */
    const sb_mesh *surface;   /* triangles or quads, open or closed, or NULL. Read at creation only, as are all below */
    const sb_vec3 *points;    /* [point_count] a cloud (m), or NULL */
    const sb_vec3 *normals;   /* [point_count] outward, of any length, 0: unknown; or NULL: none are known */
    int point_count;
    sb_vec3 low, high;        /* Laplace: the box (m); it is enlarged to leave a tenth of the target's size around the
                               * target. Equal corners (default): that */
    int cells;                /* Laplace: grid cells along the longest side of the box, in [8, 256]; default 64, which
                               * takes some 0.3 s */
    sb_allocator allocator;   /* zeros: malloc */
    sb_jobs jobs;             /* threads for the creation; zeros: none */
    unsigned cookie;          /* set by reg_default_field_def */
} reg_field_def;
REG_API reg_field_def reg_default_field_def(void);

typedef struct reg_field reg_field;

/* SB_ERROR_ARGUMENT (no target or two, a field out of range), SB_ERROR_NOT_FINITE (error->node: the point, or the
 * normal), what sb_surface_create says of the surface, SB_ERROR_MEMORY; *field is then untouched. Everything is copied.
 * Queries allocate nothing and may come from any number of threads. Release with reg_field_destroy. */
REG_API sb_result reg_field_create(const reg_field_def *def, reg_field **field, sb_error *error);
REG_API void reg_field_destroy(reg_field *field); /* NULL is fine */

/* The place of the target closest to a point. */
typedef struct reg_field_hit {
    sb_vec3 point;    /* m */
    sb_vec3 normal;   /* of the target there, unit length; 0 where none is known */
    sb_real distance; /* m */
    int item;         /* triangle (of the surface cut into triangles), or point of the cloud */
    int on_border;    /* 1: on the rim of an open target, beyond which nothing was seen */
} reg_field_hit;
/* 1 and *hit; 0 for a point that is not finite or absurdly far away (*hit untouched). guess: the item of a query
 * nearby, or -1; it changes the time, not the answer. About 1 us with a good guess. */
REG_API int reg_field_closest(const reg_field *field, sb_vec3 point, int guess, reg_field_hit *hit);

/* The potential on a line through a point. */
typedef struct reg_field_sample {
    sb_real phi;         /* m */
    sb_real phi_n;       /* slope along the direction over the length `step` */
    sb_real phi_nn;      /* derivative of phi_n along the direction (1/m); of either sign */
} reg_field_sample;
/* Samples the potential at point (m) along the unit vector direction:
 *     phi_n = [phi(s + h n/2) - phi(s - h n/2)] / h,  phi_nn = d phi_n / ds
 * with h = step (m, > 0), which rounds the potential's kink on the target off. phi_nn is the exact derivative of this
 * phi_n, from the slopes at its two ends, not a difference of its own: Newton's method then converges as it should.
 * Laplace's phi outside its box is that of the nearest point of the box. Returns 0 as above.
 * Source: Suwelack 2014, (7.3), (7.15). */
REG_API int reg_field_along(const reg_field *field, sb_vec3 point, sb_vec3 direction, sb_real step, int guess,
                            reg_field_sample *sample);
/* phi (m) at a point, and its gradient unless NULL: away from the closest point, or of the trilinear interpolation. On
 * the target itself, where the distance has none, it is 0. Returns 0 as above. */
REG_API int reg_field_at(const reg_field *field, sb_vec3 point, int guess, sb_real *phi, sb_vec3 *gradient);

/* Smallest box around the target (m). */
REG_API void reg_field_bounds(const reg_field *field, sb_vec3 *low, sb_vec3 *high);
/* Laplace: sweeps that its solution took; 0 for distances. */
REG_API int reg_field_sweeps(const reg_field *field);


#endif /* REG_FIELD_H */

/* ==== src/register/match.h ==== */
/* match: physics-based shape matching: an elastic organ whose charged surface is drawn onto a target. Floor 5.
 *
 * The organ is a body of any mesh and material (corotated; linear is the thesis' other variant). Its surface carries
 * charges, one in each triangle or at each vertex, held by the element they lie in. The surface may be the model's own
 * skin or, better, the fine surface that the coarse model was made from: then that surface is matched, not the coarse
 * model's facets. In the potential phi of the target (see field.h) a charge q A feels the force -q A grad phi, whose
 * stiffness along its line of action is taken into the system:
 *     (K + K_phi) du = -(f_int + f_phi),     f_phi = q A N_I phi' m,    K_phi = q A N_I N_J phi'' m m^T
 * One step solves this once and then raises the charge by the ratio of elastic to electric energy, held within bounds:
 * q grows from a gentle pull, by which the organ finds its way, to a firm one, by which it fits.
 *
 * Steps are quasi-static. K_phi and the slow growth of the charge give the stability that the thesis gets from Newmark
 * dynamics: with its stiffness damping the same number of steps led to the same end.
 *
 * What it cannot know: a surface that slides along itself keeps its shape. What loads normal to the surface did comes
 * out to a few hundredths of the motion or much better, from a part of the surface too; but where the organ was dragged
 * along its surface the motion found is the one of least energy, which may be off by the length of the drag. Landmarks
 * mend that.
 *
 * Sources: Suwelack 2014, chapter 7, with corrected factors: no 1/2 in f_phi and K_phi, and bounds on the growth of the
 * charge (q I_int / I_phi alone has an unstable fixed point). */
#ifndef REG_MATCH_H
#define REG_MATCH_H


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
    sb_body *body;            /* volume mesh at rest or deformed; borrowed: the match moves it, and it must outlive the
                               * match. Supports hold their nodes where they are to be (sb_body_fix_nodes for regions
                               * known not to move); dead loads, springs and mappings act; constraints are refused.
                               * Gravity acts too: leave it 0 when the rest shape already hangs in it */
    const sb_mesh *surface;   /* surface of the organ at rest, tri or quad, outward, or NULL (default): the boundary of
                               * the body. Read at creation only */
    const sb_mesh *target;    /* surface that was seen, outward, in the same frame; or NULL, then: */
    const sb_vec3 *target_points;  /* [target_count] cloud (m) */
    const sb_vec3 *target_normals; /* [target_count] outward, or NULL */
    int target_count;
    reg_match_method method;
    int cells;                /* Laplace: of the grid along the longest side, [8, 256]; default 64 */
    int partial;              /* 1: the target is a part of the surface: charges act by distance and normal. 0: all act.
                               * SB_AUTO (default): 1 for open surfaces and for clouds */
    sb_real reach, last_reach;/* partial: a charge acts within `reach`, which shrinks by 7 % a step to `last_reach`;
                               * both > 0; default 0.1, 0.02 */
    sb_real least_cosine;     /* partial: and where its normal and the target's have at least this cosine, [-1, 1];
                               * default 0.5 */
    sb_real least_active;     /* partial: least share of the surface's area that must act, [0, 1]; default 0.1. With
                               * landmarks it is not asked for */
    sb_real sampling;         /* half of it to each side of the target is where the potential is rounded off, > 0;
                               * default 0.015. The pull of a charge is full beyond and falls to 0 on the target */
    sb_real first_charge;     /* charge per area to begin with, in Young's moduli, > 0; default 0.2 */
    sb_real last_charge;      /* and most of it, >= first_charge; default 100: the shape counts, the energy
                               * decides what it leaves open. Less follows noise less */
    sb_real least_growth, most_growth; /* of the charge in a step, 1 < least <= most; default 1.15, 2 */
    const sb_vec3 *landmarks; /* [landmark_count] points on or in the organ at rest (m), or NULL */
    const sb_vec3 *landmark_targets; /* [landmark_count] where they are seen (m) */
    int landmark_count;
    sb_real landmark_stiffness; /* of each one's spring, in Young's modulus times mean element size, > 0; default 50 */
    sb_real settled;          /* the mean distance has settled when it falls by less than this share three steps
                               * running, > 0; default 0.005 */
    double max_seconds;       /* most time of all steps together, > 0; needs `clock`; default 1e9 */
    sb_clock clock;           /* default NULL: times read 0 */
    sb_allocator allocator;   /* default malloc; the threads are the body's */
    unsigned cookie;          /* set by reg_default_match_def */
} reg_match_def;
REG_API reg_match_def reg_default_match_def(void);

typedef struct reg_match reg_match;

/* How a match stands. Distances are those before the last step moved the body, since that is where it looked. */
typedef struct reg_match_info {
    int iterations;           /* steps of this match so far */
    reg_match_stop stop;
    sb_real mean_distance;    /* of the active charges from the target, by area (m) */
    sb_real max_distance;     /* m */
    sb_real landmark_distance;/* largest, of landmarks from where they are seen (m) */
    sb_real active;           /* share of the surface's area that acts */
    sb_real charge;           /* Young's moduli */
    sb_real change;           /* largest displacement of a node in the last step (m) */
    int pcg_iterations;       /* of the last step */
    double seconds;           /* of all steps; with a clock, as are those of the last step: */
    double seconds_field;     /* looking for the target, */
    double seconds_system;    /* forces and tangent, */
    double seconds_solve;     /* and the linear system */
    sb_error error;           /* of a call that failed */
} reg_match_info;

/* Makes a match; the body is not touched. SB_ERROR_ARGUMENT (field named), SB_ERROR_NOT_FINITE, SB_ERROR_MATERIAL (no
 * Young's modulus to measure charges with), SB_ERROR_UNSUPPORTED (a body with constraints or custom elements), what
 * reg_field_create says of the target and sb_embedding_create of the surface (points far outside included),
 * SB_ERROR_MEMORY; *match is then untouched. All memory that steps need is taken here. */
REG_API sb_result reg_match_create(const reg_match_def *def, reg_match **match, sb_error *error);
REG_API void reg_match_destroy(reg_match *match); /* NULL is fine; the body stays */

/* One step: moves the body and raises the charge. info may be NULL. On failure the body is as before:
 * SB_ERROR_INVERTED (element named), SB_ERROR_DIVERGED, SB_ERROR_INDEFINITE; SB_ERROR_NOT_CONVERGED when too little of
 * the surface is near the target. Allocates nothing. The same bits for any number of threads. Landmarks and supports
 * may move between steps: matching then follows them. */
REG_API sb_result reg_match_step(reg_match *match, reg_match_info *info);
/* Steps until the match settles, `steps` (>= 0) are done or the time is up: all of these are SB_OK, and info->stop says
 * which. Errors as of a step. */
REG_API sb_result reg_match_run(reg_match *match, int steps, reg_match_info *info);
/* Back to the first charge and reach, as if no step had been: for a body that was reset or moved. The time goes on. */
REG_API void reg_match_restart(reg_match *match);

/* New places of the landmarks, targets[landmark_count] (m): between any two steps. SB_ERROR_NOT_FINITE names none and
 * changes nothing; a settled match runs again. */
REG_API sb_result reg_match_move_landmarks(reg_match *match, const sb_vec3 *targets);
/* Where the landmarks are now (m): points[landmark_count]. */
REG_API void reg_match_landmarks(const reg_match *match, sb_vec3 *points);

/* The body's: sb_body_positions and sb_body_displacements are the result. */
REG_API const sb_body *reg_match_body(const reg_match *match);
REG_API reg_match_info reg_match_get_info(const reg_match *match);

/* The charges, for pictures of what acts: [reg_match_sample_count]. */
typedef struct reg_match_sample {
    sb_vec3 point;      /* m, where the last step looked */
    sb_real area;       /* m^2 at rest */
    sb_real distance;   /* m from the target */
    int active;
} reg_match_sample;
REG_API int reg_match_sample_count(const reg_match *match);
/* SB_ERROR_INDEX for no such sample; *sample is then untouched. */
REG_API sb_result reg_match_get_sample(const reg_match *match, int index, reg_match_sample *sample);

#endif /* REG_MATCH_H */

#endif /* REGISTER_H */

#if defined(REG_IMPLEMENTATION) && !defined(REG_IMPLEMENTATION_DONE)
#define REG_IMPLEMENTATION_DONE

/* ==== src/register/kdtree.h, internal ==== */
/* The points' indices in the order of the leaves, so that queries in this order find what they need in the cache:
 * order[count]. */
REGI_API void regi_kdtree_order(const reg_kdtree *tree, int *order);
/* reg_kdtree_nearest for a finite point, with the answer to begin with: index `found` (INT_MAX: none) at the squared
 * distance *squared. */
REGI_API int regi_kdtree_nearest_from(const reg_kdtree *tree, sb_vec3 point, int found, sb_real *squared);

/* ==== src/register/field.h, internal ==== */
/* 1 for a cloud, and for a surface with a rim: it may be a part of something. */
REGI_API int regi_field_is_open(const reg_field *field);

/* ==== src/register/rigid.c ==== */
/* rigid: motions and Kabsch's fit. */

REG_API reg_rigid reg_rigid_identity(void)
{
    reg_rigid motion;
    motion.rotation = sb_m3_identity();
    motion.translation = sb_v3(0, 0, 0);
    return motion;
}

REG_API sb_vec3 reg_rigid_apply(const reg_rigid *motion, sb_vec3 point)
{
    return sb_v3_add(sb_m3_apply(motion->rotation, point), motion->translation);
}

REG_API reg_rigid reg_rigid_compose(const reg_rigid *then, const reg_rigid *first)
{
    reg_rigid motion;
    motion.rotation = sb_m3_mul(then->rotation, first->rotation);
    motion.translation = reg_rigid_apply(then, first->translation);
    return motion;
}

REG_API reg_rigid reg_rigid_inverse(const reg_rigid *motion)
{
    reg_rigid inverse;
    inverse.rotation = sb_m3_transpose(motion->rotation);
    inverse.translation = sb_v3_scale(-1, sb_m3_apply(inverse.rotation, motion->translation));
    return inverse;
}

/* The axis times 2 sin, and 1 + 2 cos: together they tell small angles and such near pi alike. */
REG_API sb_real reg_rigid_angle(const reg_rigid *motion)
{
    const sb_mat3 *r = &motion->rotation;
    sb_vec3 axis = sb_v3(r->m[2][1] - r->m[1][2], r->m[0][2] - r->m[2][0], r->m[1][0] - r->m[0][1]);
    return (sb_real)atan2((double)sb_v3_norm(axis), (double)(r->m[0][0] + r->m[1][1] + r->m[2][2] - 1));
}

static sb_result regi_rigid_check(const sb_vec3 *from, const sb_vec3 *to, const sb_real *weights, int count,
                                  sb_error *error)
{
    sb_real largest = 0;
    if (!from || !to || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a fit needs at least one pair of points, not %d", count);
    for (int i = 0; i < count; i++) {
        sb_real w = weights ? weights[i] : 1;
        if (!sb_v3_is_finite(from[i]) || !sb_v3_is_finite(to[i]) || !sb_is_finite(w))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "pair %d is not finite", i);
        if (w < 0)
            return sbi_fail(error, SB_ERROR_ARGUMENT, "the weight of pair %d is %g, not 0 or more", i, (double)w);
        largest = w > largest ? w : largest;
    }
    if (!(largest > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "all weights are 0");
    return SB_OK;
}

REG_API sb_result reg_rigid_fit(const sb_vec3 *from, const sb_vec3 *to, const sb_real *weights, int count,
                                reg_rigid *motion, sb_error *error)
{
    sb_result result = regi_rigid_check(from, to, weights, count, error);
    sb_vec3 mean_from = sb_v3(0, 0, 0), mean_to = mean_from, stretches;
    sb_mat3 spread = sb_m3_zero(), u, v;
    sb_real total = 0;
    if (result != SB_OK)
        return result;
    for (int i = 0; i < count; i++) {
        sb_real w = weights ? weights[i] : 1;
        if (!(w > 0))
            continue;
        total += w;
        mean_from = sb_v3_madd(mean_from, w / total, sb_v3_sub(from[i], mean_from));
        mean_to = sb_v3_madd(mean_to, w / total, sb_v3_sub(to[i], mean_to));
    }
    for (int i = 0; i < count; i++) {
        sb_vec3 a = sb_v3_scale((weights ? weights[i] : 1) / total, sb_v3_sub(to[i], mean_to));
        spread = sb_m3_add(spread, sb_m3_outer(a, sb_v3_sub(from[i], mean_from)));
    }
    /* u and v of this factorisation are rotations, the sign of the determinant is in the last stretch: u v^T is the
     * nearest rotation. */
    sb_m3_svd(spread, &u, &stretches, &v);
    motion->rotation = sb_m3_mul(u, sb_m3_transpose(v));
    motion->translation = sb_v3_sub(mean_to, sb_m3_apply(motion->rotation, mean_from));
    return SB_OK;
}

/* ==== src/register/kdtree.c ==== */
/* kdtree: building by medians, and queries that walk down the nearer half first.
 *
 * The tree is complete: node i has the children 2i and 2i + 1, the leaves come last, and leaf j of L holds the points
 * from floor(n j / L) on. Distances and the bounds of boxes are sums of three squares in one order; each rounding is
 * monotone, so a bound never exceeds the distance of a point in the box, and nothing is lost to rounding. */

#include <limits.h>

enum { REGI_KDTREE_LEAF = 8, REGI_KDTREE_STACK = 40 };

/* Boxes around the two children. */
typedef struct regi_kdtree_node {
    sb_real low[3][2], high[3][2];
} regi_kdtree_node;

typedef struct regi_kdtree_leaf {
    sb_real x[REGI_KDTREE_LEAF], y[REGI_KDTREE_LEAF], z[REGI_KDTREE_LEAF]; /* NaN where there is no point */
    int index[REGI_KDTREE_LEAF];
} regi_kdtree_leaf;

struct reg_kdtree {
    sb_allocator allocator;
    regi_kdtree_node *nodes; /* [leaf_count]; 0 is unused */
    regi_kdtree_leaf *leaves;
    int leaf_count; /* a power of 2 */
    int count;
};

/* ---- building ---------------------------------------------------------------------------------------------------- */

typedef struct regi_kdtree_point {
    sb_real x[3];
    int index;
} regi_kdtree_point;

static void regi_kdtree_swap(regi_kdtree_point *a, regi_kdtree_point *b)
{
    regi_kdtree_point t = *a;
    *a = *b;
    *b = t;
}

/* Hoare's selection: what belongs at `middle` gets there, smaller ones before it. The pivot is drawn, so that no
 * arrangement of the points is slow; scans stop at equal keys, so that many equal points are split evenly. */
static void regi_kdtree_select(regi_kdtree_point *p, int low, int high, int middle, int axis)
{
    uint32_t draw = 2463534242u;
    while (low < high) {
        int i = low, j = high;
        sb_real pivot;
        draw ^= draw << 13, draw ^= draw >> 17, draw ^= draw << 5;
        pivot = p[low + (int)(draw % (uint32_t)(high - low + 1))].x[axis];
        while (i <= j) {
            while (p[i].x[axis] < pivot)
                i++;
            while (pivot < p[j].x[axis])
                j--;
            if (i <= j)
                regi_kdtree_swap(p + i++, p + j--);
        }
        if (middle <= j)
            high = j;
        else if (middle >= i)
            low = i;
        else
            return;
    }
}

static int regi_kdtree_start(const reg_kdtree *tree, int leaf)
{
    return (int)((int64_t)tree->count * leaf / tree->leaf_count);
}

/* Fills leaf `leaf` with the points from..to. */
static void regi_kdtree_fill(reg_kdtree *tree, int leaf, const regi_kdtree_point *p, int from, int to)
{
    regi_kdtree_leaf *out = tree->leaves + leaf;
    for (int i = 0; i < REGI_KDTREE_LEAF; i++) {
        int there = from + i < to;
        out->x[i] = there ? p[from + i].x[0] : (sb_real)NAN;
        out->y[i] = there ? p[from + i].x[1] : (sb_real)NAN;
        out->z[i] = there ? p[from + i].x[2] : (sb_real)NAN;
        out->index[i] = there ? p[from + i].index : -1;
    }
}

/* Builds `node` over the leaves first .. first + leaves - 1, and notes its box with its parent. */
static void regi_kdtree_build(reg_kdtree *tree, regi_kdtree_point *p, int node, int first, int leaves)
{
    int from = regi_kdtree_start(tree, first), to = regi_kdtree_start(tree, first + leaves), widest = 0;
    sb_real low[3], high[3];
    for (int a = 0; a < 3; a++)
        low[a] = high[a] = p[from].x[a];
    for (int i = from + 1; i < to; i++)
        for (int a = 0; a < 3; a++) {
            low[a] = sb_min(low[a], p[i].x[a]);
            high[a] = sb_max(high[a], p[i].x[a]);
        }
    for (int a = 0; a < 3; a++) {
        if (high[a] - low[a] > high[widest] - low[widest])
            widest = a;
        if (node > 1) {
            tree->nodes[node / 2].low[a][node % 2] = low[a];
            tree->nodes[node / 2].high[a][node % 2] = high[a];
        }
    }
    if (leaves == 1) {
        regi_kdtree_fill(tree, first, p, from, to);
        return;
    }
    regi_kdtree_select(p, from, to - 1, regi_kdtree_start(tree, first + leaves / 2), widest);
    regi_kdtree_build(tree, p, 2 * node, first, leaves / 2);
    regi_kdtree_build(tree, p, 2 * node + 1, first + leaves / 2, leaves / 2);
}

static sb_result regi_kdtree_check(const sb_vec3 *points, int count, sb_error *error)
{
    sb_real most = sb_sqrt(SB_REAL_MAX) / 8;
    if (!points || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a tree needs at least one point, not %d", count);
    for (int i = 0; i < count; i++) {
        if (!sb_v3_is_finite(points[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "point %d has a coordinate that is not finite", i);
        if (sb_abs(points[i].x) > most || sb_abs(points[i].y) > most || sb_abs(points[i].z) > most)
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "point %d is too far from the origin to be squared", i);
    }
    return SB_OK;
}

static reg_kdtree *regi_kdtree_allocate(int count, const sb_allocator *allocator)
{
    reg_kdtree *tree = NULL;
    int leaf_count = 1;
    while ((int64_t)leaf_count * REGI_KDTREE_LEAF < count)
        leaf_count *= 2;
    for (sbi_arena arena = {NULL, 0, 0};;) {
        reg_kdtree *head = (reg_kdtree *)sbi_arena_take(&arena, 1, sizeof(reg_kdtree));
        regi_kdtree_node *nodes = (regi_kdtree_node *)sbi_arena_take(&arena, (size_t)leaf_count, sizeof *nodes);
        regi_kdtree_leaf *leaves = (regi_kdtree_leaf *)sbi_arena_take(&arena, (size_t)leaf_count, sizeof *leaves);
        if (arena.base) {
            tree = head;
            tree->nodes = nodes;
            tree->leaves = leaves;
            tree->leaf_count = leaf_count;
            tree->count = count;
            memset(&tree->allocator, 0, sizeof tree->allocator);
            if (allocator)
                tree->allocator = *allocator;
            return tree;
        }
        arena.base = arena.overflow ? NULL : (unsigned char *)sbi_alloc(allocator, 1, arena.used);
        arena.used = 0;
        if (!arena.base)
            return NULL;
    }
}

REG_API sb_result reg_kdtree_create(const sb_vec3 *points, int count, const sb_allocator *allocator, reg_kdtree **tree,
                                    sb_error *error)
{
    sb_result result = regi_kdtree_check(points, count, error);
    regi_kdtree_point *scratch;
    reg_kdtree *made;
    if (result != SB_OK)
        return result;
    if (!tree)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "nowhere to put the tree");
    made = regi_kdtree_allocate(count, allocator);
    scratch = made ? (regi_kdtree_point *)sbi_alloc(allocator, (size_t)count, sizeof *scratch) : NULL;
    if (!scratch) {
        reg_kdtree_destroy(made);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a tree of %d points", count);
    }
    for (int i = 0; i < count; i++) {
        scratch[i].x[0] = points[i].x;
        scratch[i].x[1] = points[i].y;
        scratch[i].x[2] = points[i].z;
        scratch[i].index = i;
    }
    regi_kdtree_build(made, scratch, 1, 0, made->leaf_count);
    sbi_free(allocator, scratch);
    *tree = made;
    return SB_OK;
}

REG_API void reg_kdtree_destroy(reg_kdtree *tree)
{
    if (tree) {
        sb_allocator allocator = tree->allocator;
        sbi_free(&allocator, tree);
    }
}

REGI_API void regi_kdtree_order(const reg_kdtree *tree, int *order)
{
    for (int leaf = 0, n = 0; leaf < tree->leaf_count; leaf++)
        for (int i = 0; i < REGI_KDTREE_LEAF && tree->leaves[leaf].index[i] >= 0; i++)
            order[n++] = tree->leaves[leaf].index[i];
}

REG_API int reg_kdtree_count(const reg_kdtree *tree) { return tree ? tree->count : 0; }

/* ---- queries ----------------------------------------------------------------------------------------------------- */

/* Squared distances to the boxes of the two children. */
static void regi_kdtree_bounds(const regi_kdtree_node *node, sb_vec3 p, sb_real bound[2])
{
    sb_real gap[3][2];
    for (int c = 0; c < 2; c++) {
        gap[0][c] = sb_max(sb_max(node->low[0][c] - p.x, p.x - node->high[0][c]), 0);
        gap[1][c] = sb_max(sb_max(node->low[1][c] - p.y, p.y - node->high[1][c]), 0);
        gap[2][c] = sb_max(sb_max(node->low[2][c] - p.z, p.z - node->high[2][c]), 0);
    }
    for (int c = 0; c < 2; c++)
        bound[c] = gap[0][c] * gap[0][c] + gap[1][c] * gap[1][c] + gap[2][c] * gap[2][c];
}

/* Squared distances to the points of a leaf; NaN, which no comparison takes, where there is none. */
static void regi_kdtree_distances(const regi_kdtree_leaf *leaf, sb_vec3 p, sb_real d[REGI_KDTREE_LEAF])
{
    for (int i = 0; i < REGI_KDTREE_LEAF; i++) {
        sb_real x = leaf->x[i] - p.x, y = leaf->y[i] - p.y, z = leaf->z[i] - p.z;
        d[i] = x * x + y * y + z * z;
    }
}

/* What is left to visit. */
typedef struct regi_kdtree_walk {
    sb_real bound[REGI_KDTREE_STACK];
    int node[REGI_KDTREE_STACK];
    int depth;
} regi_kdtree_walk;

static void regi_kdtree_begin(regi_kdtree_walk *walk)
{
    walk->bound[0] = 0;
    walk->node[0] = 1;
    walk->depth = 1;
}

/* The next leaf whose box is at most sqrt(limit) away, nearer ones first, or NULL. */
static const regi_kdtree_leaf *regi_kdtree_next(const reg_kdtree *tree, regi_kdtree_walk *walk, sb_vec3 p,
                                                sb_real limit)
{
    while (walk->depth > 0) {
        int node = walk->node[--walk->depth];
        sb_real bound[2];
        if (walk->bound[walk->depth] > limit)
            continue;
        while (node < tree->leaf_count) {
            int nearer;
            regi_kdtree_bounds(tree->nodes + node, p, bound);
            nearer = bound[1] < bound[0];
            if (bound[!nearer] <= limit) {
                walk->bound[walk->depth] = bound[!nearer];
                walk->node[walk->depth++] = 2 * node + !nearer;
            }
            if (!(bound[nearer] <= limit))
                break;
            node = 2 * node + nearer;
        }
        if (node >= tree->leaf_count)
            return tree->leaves + (node - tree->leaf_count);
    }
    return NULL;
}

/* Square of a radius, or -1 for one that no point can be within; never infinite, so that points too far off to be
 * squared are no answer. */
static sb_real regi_kdtree_limit(sb_real within)
{
    if (!(within >= 0))
        return -1;
    return sb_min(within * within, SB_REAL_MAX);
}

REGI_API int regi_kdtree_nearest_from(const reg_kdtree *tree, sb_vec3 point, int found, sb_real *squared)
{
    sb_real best = *squared, d[REGI_KDTREE_LEAF];
    const regi_kdtree_leaf *leaf;
    regi_kdtree_walk walk;
    regi_kdtree_begin(&walk);
    while ((leaf = regi_kdtree_next(tree, &walk, point, best)) != NULL) {
        regi_kdtree_distances(leaf, point, d);
        for (int i = 0; i < REGI_KDTREE_LEAF; i++)
            if (d[i] <= best && (d[i] < best || leaf->index[i] < found)) {
                best = d[i];
                found = leaf->index[i];
            }
    }
    *squared = best;
    return found;
}

REG_API int reg_kdtree_nearest(const reg_kdtree *tree, sb_vec3 point, sb_real within, sb_real *squared)
{
    sb_real best = regi_kdtree_limit(within);
    int found;
    if (!tree || best < 0 || !sb_v3_is_finite(point))
        return -1;
    found = regi_kdtree_nearest_from(tree, point, INT_MAX, &best);
    if (found == INT_MAX)
        return -1;
    if (squared)
        *squared = best;
    return found;
}

static int regi_kdtree_farther(const int *indices, const sb_real *squared, int a, int b)
{
    return squared[a] > squared[b] || (squared[a] == squared[b] && indices[a] > indices[b]);
}

static void regi_kdtree_exchange(int *indices, sb_real *squared, int a, int b)
{
    int index = indices[a];
    sb_real d = squared[a];
    indices[a] = indices[b], indices[b] = index;
    squared[a] = squared[b], squared[b] = d;
}

/* Restores a heap with the farthest on top after entry `at` has become nearer. */
static void regi_kdtree_sink(int *indices, sb_real *squared, int count, int at)
{
    for (;;) {
        int child = 2 * at + 1;
        if (child >= count)
            return;
        if (child + 1 < count && regi_kdtree_farther(indices, squared, child + 1, child))
            child++;
        if (!regi_kdtree_farther(indices, squared, child, at))
            return;
        regi_kdtree_exchange(indices, squared, at, child);
        at = child;
    }
}

static void regi_kdtree_rise(int *indices, sb_real *squared, int at)
{
    for (; at > 0 && regi_kdtree_farther(indices, squared, at, (at - 1) / 2); at = (at - 1) / 2)
        regi_kdtree_exchange(indices, squared, at, (at - 1) / 2);
}

REG_API int reg_kdtree_k_nearest(const reg_kdtree *tree, sb_vec3 point, int k, int *indices, sb_real *squared)
{
    sb_real limit = SB_REAL_MAX, d[REGI_KDTREE_LEAF];
    const regi_kdtree_leaf *leaf;
    regi_kdtree_walk walk;
    int count = 0;
    if (!tree || k < 1 || !indices || !squared || !sb_v3_is_finite(point))
        return 0;
    regi_kdtree_begin(&walk);
    while ((leaf = regi_kdtree_next(tree, &walk, point, limit)) != NULL) {
        regi_kdtree_distances(leaf, point, d);
        for (int i = 0; i < REGI_KDTREE_LEAF; i++) {
            if (!(d[i] <= limit) || (count == k && d[i] == limit && leaf->index[i] > indices[0]))
                continue;
            if (count < k) {
                indices[count] = leaf->index[i];
                squared[count] = d[i];
                regi_kdtree_rise(indices, squared, count++);
            } else {
                indices[0] = leaf->index[i];
                squared[0] = d[i];
                regi_kdtree_sink(indices, squared, count, 0);
            }
            if (count == k)
                limit = squared[0];
        }
    }
    for (int last = count - 1; last > 0; last--) {
        regi_kdtree_exchange(indices, squared, 0, last);
        regi_kdtree_sink(indices, squared, last, 0);
    }
    return count;
}

REG_API int reg_kdtree_within(const reg_kdtree *tree, sb_vec3 point, sb_real radius, int *indices, int room)
{
    sb_real limit = regi_kdtree_limit(radius), d[REGI_KDTREE_LEAF];
    const regi_kdtree_leaf *leaf;
    regi_kdtree_walk walk;
    int count = 0;
    if (!tree || limit < 0 || !sb_v3_is_finite(point))
        return 0;
    regi_kdtree_begin(&walk);
    while ((leaf = regi_kdtree_next(tree, &walk, point, limit)) != NULL) {
        regi_kdtree_distances(leaf, point, d);
        for (int i = 0; i < REGI_KDTREE_LEAF; i++)
            if (d[i] <= limit) {
                if (indices && count < room)
                    indices[count] = leaf->index[i];
                count++;
            }
    }
    return count;
}

/* ==== src/register/field.c ==== */
/* field: distances to surfaces and clouds, and Laplace's potential on a grid. */

#include <string.h>


#define REGI_FIELD_COOKIE 0x66696c64u

enum { REGI_FIELD_NEIGHBOURS = 12 }; /* points of a cloud that tell whether one of them is on its rim */

/* Laplace's potential at the corners of a grid of cubes. */
typedef struct regi_field_grid {
    sb_vec3 low;
    sb_real cell;           /* m */
    int count[3];           /* corners along each axis */
    sb_real *phi;           /* [corners] m, x fastest */
    int sweeps;
} regi_field_grid;

struct reg_field {
    sb_allocator allocator;
    reg_field_kind kind;
    sb_vec3 low, high;
    sb_surface *surface;
    reg_kdtree *tree;       /* of a cloud; NULL for a surface */
    int point_count;
    sb_vec3 *points;        /* of the cloud */
    sb_vec3 *normals;       /* of the cloud, unit or 0; NULL: none */
    unsigned char *border;  /* triangles: bit i for edge i, bit 3 + i for corner i; points: 1 */
    regi_field_grid grid;
};

REG_API reg_field_def reg_default_field_def(void)
{
    reg_field_def def;
    memset(&def, 0, sizeof def);
    def.kind = REG_FIELD_DISTANCE;
    def.cells = 64;
    def.cookie = REGI_FIELD_COOKIE;
    return def;
}

REG_API void reg_field_destroy(reg_field *field)
{
    sb_allocator allocator;
    if (!field)
        return;
    allocator = field->allocator;
    sb_surface_destroy(field->surface);
    reg_kdtree_destroy(field->tree);
    sbi_free(&allocator, field->points);
    sbi_free(&allocator, field->normals);
    sbi_free(&allocator, field->border);
    sbi_free(&allocator, field->grid.phi);
    sbi_free(&allocator, field);
}

/* ---- checks ---- */

static sb_result regi_field_check_points(const reg_field_def *def, sb_error *error)
{
    if (def->point_count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a cloud of %d points is no target", def->point_count);
    for (int i = 0; i < def->point_count; i++) {
        if (!sb_v3_is_finite(def->points[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "point %d of the target is not finite", i);
        if (def->normals && !sb_v3_is_finite(def->normals[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "normal %d of the target is not finite", i);
    }
    return SB_OK;
}

static sb_result regi_field_check(const reg_field_def *def, sb_error *error)
{
    if (!def || def->cookie != REGI_FIELD_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a field needs a def made by reg_default_field_def");
    if (def->kind != REG_FIELD_DISTANCE && def->kind != REG_FIELD_LAPLACE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "there is no field of kind %d", (int)def->kind);
    if ((def->surface != NULL) == (def->points != NULL))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a field needs either a surface or points");
    if (def->cells < 8 || def->cells > 256)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "cells is %d, not in [8, 256]", def->cells);
    if (!sb_v3_is_finite(def->low) || !sb_v3_is_finite(def->high))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "a corner of the field's box is not finite");
    if (def->high.x < def->low.x || def->high.y < def->low.y || def->high.z < def->low.z)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the box of the field has high below low");
    return def->points ? regi_field_check_points(def, error) : SB_OK;
}

/* ---- a surface and its rim ---- */

/* Bits of the edges that no other triangle shares, then of all corners at such edges. rim: scratch [nodes], zeroed. */
static void regi_field_mark_border(const sb_mesh *mesh, const sb_index_table *neighbours, unsigned char *rim,
                                   unsigned char *border)
{
    for (int t = 0; t < mesh->element_count; t++) {
        border[t] = 0;
        for (int i = 0; i < 3; i++)
            if (neighbours->items[3 * t + i] < 0) {
                border[t] = (unsigned char)(border[t] | 1 << i);
                rim[mesh->elements[3 * t + i]] = rim[mesh->elements[3 * t + (i + 1) % 3]] = 1;
            }
    }
    for (int t = 0; t < mesh->element_count; t++)
        for (int i = 0; i < 3; i++)
            if (rim[mesh->elements[3 * t + i]])
                border[t] = (unsigned char)(border[t] | 8 << i);
}

static sb_result regi_field_find_border(reg_field *field, const sb_mesh *mesh, sb_error *error)
{
    sb_index_table neighbours;
    unsigned char *rim;
    sb_result result = sb_mesh_neighbours(mesh, &field->allocator, &neighbours, error);
    if (result != SB_OK)
        return result;
    rim = (unsigned char *)sbi_alloc_zeroed(&field->allocator, (size_t)mesh->node_count, 1);
    field->border = (unsigned char *)sbi_alloc(&field->allocator, (size_t)mesh->element_count, 1);
    if (rim && field->border)
        regi_field_mark_border(mesh, &neighbours, rim, field->border);
    else
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the rim of %d triangles", mesh->element_count);
    sbi_free(&field->allocator, rim);
    sb_index_table_free(&neighbours);
    return result;
}

static sb_result regi_field_make_surface(reg_field *field, const sb_mesh *surface, sb_error *error)
{
    sb_mesh triangles;
    sb_result result = sb_surface_triangulate(surface, &field->allocator, &triangles, error);
    if (result != SB_OK)
        return result;
    result = sb_surface_create(&triangles, &field->allocator, &field->surface, error);
    if (result == SB_OK)
        result = regi_field_find_border(field, &triangles, error);
    if (result == SB_OK)
        sb_surface_bounds(field->surface, &field->low, &field->high);
    sb_mesh_free(&triangles);
    return result;
}

/* ---- a cloud and its rim ---- */

/* On a rim the neighbours lie to one side: the centre of a half disc is 0.42 radii from the middle of its straight
 * edge. */
static int regi_field_is_rim(const reg_field *field, int point)
{
    int near[REGI_FIELD_NEIGHBOURS];
    sb_real squares[REGI_FIELD_NEIGHBOURS];
    sb_vec3 centre = sb_v3(0, 0, 0), at = field->points[point];
    int count = reg_kdtree_k_nearest(field->tree, at, REGI_FIELD_NEIGHBOURS, near, squares);
    if (count < REGI_FIELD_NEIGHBOURS)
        return 0;
    for (int i = 0; i < count; i++)
        centre = sb_v3_madd(centre, (sb_real)1 / (sb_real)count, sb_v3_sub(field->points[near[i]], at));
    return sb_v3_dot(centre, centre) > (sb_real)(0.3 * 0.3) * squares[count - 1];
}

enum { REGI_FIELD_CHUNK = 1024 };

static void regi_field_find_rims(void *user, int chunk)
{
    reg_field *field = (reg_field *)user;
    int first = chunk * REGI_FIELD_CHUNK, last = first + sbi_min_int(REGI_FIELD_CHUNK, field->point_count - first);
    for (int i = first; i < last; i++)
        field->border[i] = (unsigned char)regi_field_is_rim(field, i);
}

static sb_result regi_field_make_cloud(reg_field *field, const reg_field_def *def, sb_error *error)
{
    size_t count = (size_t)def->point_count;
    sb_result result = reg_kdtree_create(def->points, def->point_count, &field->allocator, &field->tree, error);
    if (result != SB_OK)
        return result;
    field->point_count = def->point_count;
    field->points = (sb_vec3 *)sbi_alloc(&field->allocator, count, sizeof(sb_vec3));
    field->border = (unsigned char *)sbi_alloc(&field->allocator, count, 1);
    if (def->normals)
        field->normals = (sb_vec3 *)sbi_alloc(&field->allocator, count, sizeof(sb_vec3));
    if (!field->points || !field->border || (def->normals && !field->normals))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a target of %d points", def->point_count);
    memcpy(field->points, def->points, count * sizeof(sb_vec3));
    field->low = field->high = def->points[0];
    for (int i = 0; i < def->point_count; i++) {
        sb_vec3 p = def->points[i], n = def->normals ? def->normals[i] : p;
        sb_real length = sb_v3_norm(n);
        field->low = sb_v3(sb_min(field->low.x, p.x), sb_min(field->low.y, p.y), sb_min(field->low.z, p.z));
        field->high = sb_v3(sb_max(field->high.x, p.x), sb_max(field->high.y, p.y), sb_max(field->high.z, p.z));
        if (def->normals)
            field->normals[i] = length > 0 ? sb_v3_scale((sb_real)1 / length, n) : sb_v3(0, 0, 0);
    }
    sbi_run(&def->jobs, regi_field_find_rims, field, (def->point_count - 1) / REGI_FIELD_CHUNK + 1);
    return SB_OK;
}

/* ---- closest places ---- */

static int regi_field_closest_triangle(const reg_field *field, sb_vec3 point, int guess, reg_field_hit *hit)
{
    sb_surface_hit found;
    unsigned rim;
    if (!sb_surface_closest_from(field->surface, point, SB_REAL_MAX, guess, &found))
        return 0;
    rim = field->border[found.triangle];
    hit->point = found.point;
    hit->normal = sb_surface_normal(field->surface, &found);
    hit->distance = found.distance;
    hit->item = found.triangle;
    hit->on_border = (found.feature == SB_SURFACE_EDGE && (rim >> found.index & 1)) ||
                     (found.feature == SB_SURFACE_VERTEX && (rim >> (3 + found.index) & 1));
    return 1;
}

static int regi_field_closest_point(const reg_field *field, sb_vec3 point, reg_field_hit *hit)
{
    sb_real square = 0;
    int nearest = sb_v3_is_finite(point) ? reg_kdtree_nearest(field->tree, point, SB_REAL_MAX, &square) : -1;
    if (nearest < 0 || !sb_is_finite(square))
        return 0;
    hit->point = field->points[nearest];
    hit->normal = field->normals ? field->normals[nearest] : sb_v3(0, 0, 0);
    hit->distance = sb_sqrt(square);
    hit->item = nearest;
    hit->on_border = field->border[nearest];
    return 1;
}

REG_API int reg_field_closest(const reg_field *field, sb_vec3 point, int guess, reg_field_hit *hit)
{
    return field->tree ? regi_field_closest_point(field, point, hit)
                       : regi_field_closest_triangle(field, point, guess, hit);
}

/* ---- the grid ---- */

/* Cell and place within it, in [0, 1], along one axis. */
static int regi_field_locate(sb_real x, sb_real low, sb_real cell, int corners, sb_real *share)
{
    sb_real place = (x - low) / cell, last = (sb_real)(corners - 1);
    int index;
    place = sb_max(0, sb_min(place, last));
    index = sbi_min_int((int)place, corners - 2);
    *share = place - (sb_real)index;
    return index;
}

/* Trilinear interpolation and its gradient. */
static sb_real regi_field_interpolate(const regi_field_grid *grid, sb_vec3 point, sb_vec3 *gradient)
{
    sb_real s[3], phi = 0, slope[3] = {0, 0, 0};
    int i = regi_field_locate(point.x, grid->low.x, grid->cell, grid->count[0], &s[0]);
    int j = regi_field_locate(point.y, grid->low.y, grid->cell, grid->count[1], &s[1]);
    int k = regi_field_locate(point.z, grid->low.z, grid->cell, grid->count[2], &s[2]);
    size_t row = (size_t)grid->count[0], plane = row * (size_t)grid->count[1];
    const sb_real *at = grid->phi + (size_t)i + (size_t)j * row + (size_t)k * plane;
    for (int corner = 0; corner < 8; corner++) {
        int bit[3] = {corner & 1, corner >> 1 & 1, corner >> 2};
        sb_real value = at[(size_t)bit[0] + (size_t)bit[1] * row + (size_t)bit[2] * plane], w[3];
        for (int a = 0; a < 3; a++)
            w[a] = bit[a] ? s[a] : 1 - s[a];
        phi += w[0] * w[1] * w[2] * value;
        for (int a = 0; a < 3; a++)
            slope[a] += (bit[a] ? value : -value) * w[(a + 1) % 3] * w[(a + 2) % 3];
    }
    *gradient = sb_v3_scale((sb_real)1 / grid->cell, sb_v3(slope[0], slope[1], slope[2]));
    return phi;
}

static sb_vec3 regi_field_corner(const regi_field_grid *grid, int i, int j, int k)
{
    return sb_v3_madd(grid->low, grid->cell, sb_v3((sb_real)i, (sb_real)j, (sb_real)k));
}

/* What setting up the grid's rows of corners needs; each (j, k) is one task. */
typedef struct regi_field_filling {
    const reg_field *field;
    unsigned char *held; /* [corners] 1: the value is given */
} regi_field_filling;

/* Corners next to the target have their distance to it, which is what its zero means for them; those on the box
 * have theirs too; all others start there. */
static void regi_field_fill_row(void *user, int row)
{
    const regi_field_filling *filling = (const regi_field_filling *)user;
    const regi_field_grid *grid = &filling->field->grid;
    int j = row % grid->count[1], k = row / grid->count[1], guess = -1;
    int outer = j == 0 || k == 0 || j == grid->count[1] - 1 || k == grid->count[2] - 1;
    for (int i = 0; i < grid->count[0]; i++) {
        size_t at = (size_t)row * (size_t)grid->count[0] + (size_t)i;
        reg_field_hit hit;
        hit.distance = 0;
        if (reg_field_closest(filling->field, regi_field_corner(grid, i, j, k), guess, &hit))
            guess = hit.item;
        grid->phi[at] = hit.distance;
        filling->held[at] = outer || i == 0 || i == grid->count[0] - 1 || hit.distance < (sb_real)0.87 * grid->cell;
    }
}

/* One half sweep of successive over-relaxation over the corners of one colour of a chessboard. Returns the largest
 * change. */
static sb_real regi_field_relax(regi_field_grid *grid, const unsigned char *held, int colour, sb_real omega)
{
    size_t row = (size_t)grid->count[0], plane = row * (size_t)grid->count[1];
    sb_real most = 0;
    for (int k = 1; k < grid->count[2] - 1; k++)
        for (int j = 1; j < grid->count[1] - 1; j++) {
            sb_real *phi = grid->phi + (size_t)k * plane + (size_t)j * row;
            const unsigned char *given = held + (size_t)k * plane + (size_t)j * row;
            for (int i = 1 + (j + k + colour) % 2; i < grid->count[0] - 1; i += 2) {
                sb_real *p = phi + i;
                sb_real mean = (p[-1] + p[1] + *(p - row) + *(p + row) + *(p - plane) + *(p + plane)) / 6;
                sb_real change = given[i] ? 0 : omega * (mean - *p);
                *p += change;
                most = sb_max(most, sb_abs(change));
            }
        }
    return most;
}

/* The factor that is best for a cube of as many cells. */
static sb_real regi_field_omega(const regi_field_grid *grid)
{
    sb_real s, c;
    int longest = sbi_max_int(grid->count[0], sbi_max_int(grid->count[1], grid->count[2]));
    sb_sin_cos((sb_real)3.14159265358979 / (sb_real)longest, &s, &c);
    return 2 / (1 + s);
}

/* Until no corner changes by more than 1e-4 cells in a sweep, which is far below what the grid resolves. */
static void regi_field_solve(regi_field_grid *grid, const unsigned char *held)
{
    sb_real omega = regi_field_omega(grid), enough = (sb_real)1e-4 * grid->cell, change = enough + 1;
    for (grid->sweeps = 0; grid->sweeps < 2000 && change > enough; grid->sweeps++) {
        change = regi_field_relax(grid, held, 0, omega);
        change = sb_max(change, regi_field_relax(grid, held, 1, omega));
    }
}

/* The box of the def, enlarged, and the number of corners; 0 when it is too large for numbers. */
static int regi_field_plan(reg_field *field, const reg_field_def *def)
{
    regi_field_grid *grid = &field->grid;
    sb_real margin = (sb_real)0.1 * sb_v3_norm(sb_v3_sub(field->high, field->low)), longest;
    sb_vec3 edge, low = sb_v3_sub(field->low, sb_v3(margin, margin, margin));
    sb_vec3 high = sb_v3_add(field->high, sb_v3(margin, margin, margin)), size = sb_v3_sub(def->high, def->low);
    if (size.x > 0 || size.y > 0 || size.z > 0) {
        low = sb_v3(sb_min(low.x, def->low.x), sb_min(low.y, def->low.y), sb_min(low.z, def->low.z));
        high = sb_v3(sb_max(high.x, def->high.x), sb_max(high.y, def->high.y), sb_max(high.z, def->high.z));
    }
    edge = sb_v3_sub(high, low);
    longest = sb_max(edge.x, sb_max(edge.y, edge.z));
    if (!sb_is_finite(longest) || !sb_v3_is_finite(edge))
        return 0;
    grid->low = low;
    grid->cell = longest > 0 ? longest / (sb_real)def->cells : 1;
    grid->count[0] = sbi_max_int((int)(edge.x / grid->cell + (sb_real)0.999), 2) + 1;
    grid->count[1] = sbi_max_int((int)(edge.y / grid->cell + (sb_real)0.999), 2) + 1;
    grid->count[2] = sbi_max_int((int)(edge.z / grid->cell + (sb_real)0.999), 2) + 1;
    return 1;
}

static sb_result regi_field_make_grid(reg_field *field, const reg_field_def *def, sb_error *error)
{
    regi_field_filling filling;
    size_t corners;
    if (!regi_field_plan(field, def))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the target is too large for a potential");
    corners = (size_t)field->grid.count[0] * (size_t)field->grid.count[1] * (size_t)field->grid.count[2];
    field->grid.phi = (sb_real *)sbi_alloc(&field->allocator, corners, sizeof(sb_real));
    filling.field = field;
    filling.held = (unsigned char *)sbi_alloc(&field->allocator, corners, 1);
    if (!field->grid.phi || !filling.held) {
        sbi_free(&field->allocator, filling.held);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a potential of %d cells a side", def->cells);
    }
    sbi_run(&def->jobs, regi_field_fill_row, &filling, field->grid.count[1] * field->grid.count[2]);
    regi_field_solve(&field->grid, filling.held);
    sbi_free(&field->allocator, filling.held);
    return SB_OK;
}

/* ---- life ---- */

REG_API sb_result reg_field_create(const reg_field_def *def, reg_field **field, sb_error *error)
{
    reg_field *made;
    sb_result result = regi_field_check(def, error);
    if (result == SB_OK && !field)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "there is no place for the field");
    if (result != SB_OK)
        return result;
    made = (reg_field *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a field");
    made->allocator = def->allocator;
    made->kind = def->kind;
    result = def->surface ? regi_field_make_surface(made, def->surface, error)
                          : regi_field_make_cloud(made, def, error);
    if (result == SB_OK && def->kind == REG_FIELD_LAPLACE)
        result = regi_field_make_grid(made, def, error);
    if (result != SB_OK) {
        reg_field_destroy(made);
        return result;
    }
    *field = made;
    return SB_OK;
}

/* ---- the potential ---- */

REG_API int reg_field_at(const reg_field *field, sb_vec3 point, int guess, sb_real *phi, sb_vec3 *gradient)
{
    reg_field_hit hit;
    sb_vec3 slope = sb_v3(0, 0, 0);
    if (field->kind == REG_FIELD_LAPLACE) {
        if (!sb_v3_is_finite(point))
            return 0;
        *phi = regi_field_interpolate(&field->grid, point, &slope);
    } else {
        if (!reg_field_closest(field, point, guess, &hit))
            return 0;
        *phi = hit.distance;
        if (hit.distance > 0)
            slope = sb_v3_scale((sb_real)1 / hit.distance, sb_v3_sub(point, hit.point));
    }
    if (gradient)
        *gradient = slope;
    return 1;
}

REG_API int reg_field_along(const reg_field *field, sb_vec3 point, sb_vec3 direction, sb_real step, int guess,
                            reg_field_sample *sample)
{
    sb_real half = (sb_real)0.5 * step, before, after, phi;
    sb_vec3 slope_before, slope_after;
    if (!reg_field_at(field, point, guess, &phi, NULL) ||
        !reg_field_at(field, sb_v3_madd(point, -half, direction), guess, &before, &slope_before) ||
        !reg_field_at(field, sb_v3_madd(point, half, direction), guess, &after, &slope_after))
        return 0;
    sample->phi = phi;
    sample->phi_n = (after - before) / step;
    sample->phi_nn = sb_v3_dot(direction, sb_v3_sub(slope_after, slope_before)) / step;
    return 1;
}

REG_API void reg_field_bounds(const reg_field *field, sb_vec3 *low, sb_vec3 *high)
{
    *low = field->low;
    *high = field->high;
}

REGI_API int regi_field_is_open(const reg_field *field)
{
    int triangles = field->surface ? sb_surface_triangle_count(field->surface) : 0;
    for (int t = 0; t < triangles; t++)
        if (field->border[t])
            return 1;
    return field->tree != NULL;
}

REG_API int reg_field_sweeps(const reg_field *field) { return field->grid.sweeps; }

/* ==== src/register/match_state.h ==== */
/* match_state: what is inside a reg_match. Floor 5, internal: match.c makes it, match_step.c moves it. */
#ifndef REG_MATCH_STATE_H
#define REG_MATCH_STATE_H


/* Charges per task of the look at the target: fixed, whatever the threads. */
enum { REGI_MATCH_CHUNK = 128 };

/* A charge, or a landmark: a point of an element. Its weights and their gradients at rest are in rows of their own. */
typedef struct regi_match_charge {
    int element;
    int index;         /* triangle, vertex or landmark it is */
    sb_real area;      /* m^2 at rest */
    sb_vec3 normal;    /* outward at rest */
    /* of the last look */
    int guess;         /* item of the field that was closest, or -1 */
    int active;
    sb_vec3 point;     /* m */
    sb_vec3 force;     /* slope of the potential: of unit charge, away from the target */
    sb_vec3 line;      /* unit vector along which it is stiff */
    sb_real stiffness; /* along it (1/m), >= 0 */
    sb_real distance;  /* m */
    sb_real energy;    /* potential (m) */
} regi_match_charge;

struct reg_match {
    sb_allocator allocator;
    sb_clock clock;
    sb_body *body;
    reg_field *field;
    reg_match_method method;
    int partial;
    sb_real size;              /* of the organ (m) */
    sb_real young;             /* Pa */
    sb_real rounding;          /* half of the sampling length (m) */
    sb_real first_reach, last_reach; /* m */
    sb_real least_cosine, least_active;
    sb_real first_charge, last_charge, least_growth, most_growth, settled;
    sb_real landmark_stiffness; /* N/m */
    double max_seconds;

    void *memory;              /* the one block behind the arrays */
    int charge_count, landmark_count, width; /* width: nodes per element */
    regi_match_charge *charges; /* [charge_count + landmark_count], each kind by element */
    sb_real *weights;          /* [charges and landmarks][width] */
    sb_vec3 *gradients;        /* [charges][width] of the weights, at rest (1/m) */
    sb_vec3 *targets;          /* [landmark_count], in the order of the def */
    sb_vec3 *pull;             /* [nodes] force of charges and landmarks (N) */
    sb_vec3 *trial;            /* [nodes] */
    sb_real *local;            /* [3 width][3 width] stiffness of an element's charges */
    double total_area;

    /* state */
    sb_real charge, reach;     /* Young's moduli; m */
    sb_real last_mean;         /* m */
    int calm;                  /* steps running that the mean distance did not fall */
    reg_match_info info;
};

/* Where a charge or landmark is now (m). */
REGI_API sb_vec3 regi_match_point(const reg_match *match, int charge);

#endif /* REG_MATCH_STATE_H */

/* ==== src/register/match.c ==== */
/* match: what a match is made from, and its charges. */

#include <string.h>


#define REGI_MATCH_COOKIE 0x6d617463u

enum { REGI_MATCH_TRIANGLES = 4000 }; /* finer surfaces carry their charges at the vertices, which are half as many */

REG_API reg_match_def reg_default_match_def(void)
{
    reg_match_def def;
    memset(&def, 0, sizeof def);
    def.method = REG_PBSM;
    def.cells = 64;
    def.partial = SB_AUTO;
    def.reach = (sb_real)0.1;
    def.last_reach = (sb_real)0.02;
    def.least_cosine = (sb_real)0.5;
    def.least_active = (sb_real)0.1;
    def.sampling = (sb_real)0.015;
    def.first_charge = (sb_real)0.2;
    def.last_charge = 100;
    def.least_growth = (sb_real)1.15;
    def.most_growth = 2;
    def.landmark_stiffness = 50;
    def.settled = (sb_real)0.005;
    def.max_seconds = 1e9;
    def.cookie = REGI_MATCH_COOKIE;
    return def;
}

/* ---- checks ---- */

static sb_result regi_match_check_numbers(const reg_match_def *def, sb_error *error)
{
    const struct {
        const char *name;
        sb_real value, low, high;
    } fields[] = {{"reach", def->reach, 0, SB_REAL_MAX},
                  {"last_reach", def->last_reach, 0, SB_REAL_MAX},
                  {"least_cosine", def->least_cosine, -1, 1},
                  {"least_active", def->least_active, 0, 1},
                  {"sampling", def->sampling, 0, SB_REAL_MAX},
                  {"first_charge", def->first_charge, 0, SB_REAL_MAX},
                  {"last_charge", def->last_charge, def->first_charge, SB_REAL_MAX},
                  {"least_growth", def->least_growth, 1, SB_REAL_MAX},
                  {"most_growth", def->most_growth, def->least_growth, SB_REAL_MAX},
                  {"landmark_stiffness", def->landmark_stiffness, 0, SB_REAL_MAX},
                  {"settled", def->settled, 0, SB_REAL_MAX}};
    for (size_t i = 0; i < sizeof fields / sizeof fields[0]; i++)
        if (!sb_is_finite(fields[i].value) || fields[i].value < fields[i].low || fields[i].value > fields[i].high)
            return sbi_fail(error, SB_ERROR_ARGUMENT, "%s of a match is %g, out of range", fields[i].name,
                            (double)fields[i].value);
    if (!(def->reach > 0 && def->last_reach > 0 && def->sampling > 0 && def->first_charge > 0 && def->settled > 0 &&
          def->landmark_stiffness > 0 && def->least_growth > 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "reaches, sampling, charges, settled and landmark_stiffness of a "
                        "match must be above 0, least_growth above 1");
    if (!(def->max_seconds > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_seconds is %g, not above 0", def->max_seconds);
    return SB_OK;
}

static sb_result regi_match_check_landmarks(const reg_match_def *def, sb_error *error)
{
    if (def->landmark_count < 0 || (def->landmark_count > 0 && (!def->landmarks || !def->landmark_targets)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d landmarks need points and targets", def->landmark_count);
    for (int i = 0; i < def->landmark_count; i++)
        if (!sb_v3_is_finite(def->landmarks[i]) || !sb_v3_is_finite(def->landmark_targets[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "landmark %d is not finite", i);
    return SB_OK;
}

static sb_result regi_match_check(const reg_match_def *def, sb_error *error)
{
    sb_result result;
    if (!def || def->cookie != REGI_MATCH_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a match needs a def made by reg_default_match_def");
    if (!def->body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a match needs a body");
    if ((def->target != NULL) == (def->target_points != NULL))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a match needs either a target or target_points");
    if (def->method != REG_PBSM && def->method != REG_PBSM_LAPLACE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "there is no method %d of matching", (int)def->method);
    if (def->partial != SB_AUTO && def->partial != 0 && def->partial != 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "partial is %d, not 0, 1 or SB_AUTO", def->partial);
    if (def->body->elimination)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "a body with constraints cannot be matched");
    if (def->body->domain.element_type == SB_CUSTOM)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "a body of custom elements cannot be matched");
    result = regi_match_check_numbers(def, error);
    return result == SB_OK ? regi_match_check_landmarks(def, error) : result;
}

/* ---- where the charges sit ---- */

/* Points of a surface that carry its charges. */
typedef struct regi_match_sites {
    int count;
    sb_vec3 *points;
    sb_vec3 *areas; /* vectors (m^2) */
} regi_match_sites;

static void regi_match_free_sites(const sb_allocator *allocator, regi_match_sites *sites)
{
    sbi_free(allocator, sites->points);
    sbi_free(allocator, sites->areas);
}

static void regi_match_place_sites(const sb_mesh *triangles, int at_vertices, regi_match_sites *sites)
{
    const sb_real third = (sb_real)1 / 3;
    for (int t = 0; t < triangles->element_count; t++) {
        const int *c = triangles->elements + 3 * t;
        sb_vec3 a = triangles->nodes[c[0]], b = triangles->nodes[c[1]], d = triangles->nodes[c[2]];
        sb_vec3 area = sb_v3_scale((sb_real)0.5, sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(d, a)));
        if (!at_vertices) {
            sites->points[t] = sb_v3_scale(third, sb_v3_add(a, sb_v3_add(b, d)));
            sites->areas[t] = area;
        }
        for (int k = 0; k < 3 && at_vertices; k++) {
            sites->points[c[k]] = triangles->nodes[c[k]];
            sites->areas[c[k]] = sb_v3_madd(sites->areas[c[k]], third, area);
        }
    }
}

/* Those without area (unused vertices, flat triangles) carry nothing. */
static void regi_match_drop_sites(regi_match_sites *sites)
{
    int kept = 0;
    for (int i = 0; i < sites->count; i++)
        if (sb_v3_norm(sites->areas[i]) > 0) {
            sites->points[kept] = sites->points[i];
            sites->areas[kept++] = sites->areas[i];
        }
    sites->count = kept;
}

static sb_result regi_match_make_sites(const sb_mesh *surface, const sb_allocator *allocator, regi_match_sites *sites,
                                       sb_error *error)
{
    sb_mesh triangles;
    int at_vertices;
    sb_result result = sb_surface_triangulate(surface, allocator, &triangles, error);
    if (result != SB_OK)
        return result;
    at_vertices = triangles.element_count > REGI_MATCH_TRIANGLES;
    sites->count = at_vertices ? triangles.node_count : triangles.element_count;
    sites->points = (sb_vec3 *)sbi_alloc_zeroed(allocator, (size_t)sites->count, sizeof(sb_vec3));
    sites->areas = (sb_vec3 *)sbi_alloc_zeroed(allocator, (size_t)sites->count, sizeof(sb_vec3));
    if (sites->points && sites->areas) {
        regi_match_place_sites(&triangles, at_vertices, sites);
        regi_match_drop_sites(sites);
        if (sites->count == 0)
            result = sbi_fail(error, SB_ERROR_MESH, "the organ's surface has no area");
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d charges", sites->count);
    }
    sb_mesh_free(&triangles);
    return result;
}

static sb_mesh regi_match_mesh(const sb_body *body)
{
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    mesh.node_count = body->domain.node_count;
    mesh.nodes = body->reference;
    mesh.element_type = body->domain.element_type;
    mesh.element_count = body->domain.cell_count;
    mesh.elements = body->domain.cells;
    return mesh;
}

/* Charges of the def's surface, or of the body's boundary. */
static sb_result regi_match_find_sites(const reg_match_def *def, regi_match_sites *sites, sb_error *error)
{
    sb_mesh mesh = regi_match_mesh(def->body);
    sb_boundary boundary;
    sb_result result;
    memset(sites, 0, sizeof *sites);
    if (def->surface) {
        result = regi_match_make_sites(def->surface, &def->allocator, sites, error);
    } else {
        result = sb_mesh_boundary(&mesh, 1, &def->allocator, &boundary, error);
        if (result != SB_OK)
            return result;
        result = regi_match_make_sites(&boundary.surface, &def->allocator, sites, error);
        sb_boundary_free(&boundary);
    }
    if (result != SB_OK)
        regi_match_free_sites(&def->allocator, sites);
    return result;
}

/* ---- points held by elements ---- */

/* Weights of the nodes, and unless NULL their gradients at rest, of an embedded point. Outside the mesh both are those
 * of the nearest point of the element, carried on linearly: exact for affine motions. */
static void regi_match_weigh(const sb_mesh *mesh, const sb_embedded_point *point, sb_real *weights, sb_vec3 *gradients)
{
    sb_real slope[SB_MAX_ELEMENT_NODES][3];
    sb_mat3 jacobian = sb_m3_zero(), inverse;
    int width = sb_mesh_element_width(mesh);
    const int *nodes = mesh->elements + (size_t)point->element * (size_t)width;
    sb_element_shape(mesh->element_type, point->xi, weights, slope);
    for (int a = 0; a < width; a++) {
        sb_vec3 s = sb_v3(slope[a][0], slope[a][1], slope[a][2]);
        weights[a] += s.x * point->step[0] + s.y * point->step[1] + s.z * point->step[2];
        jacobian = sb_m3_add(jacobian, sb_m3_outer(mesh->nodes[nodes[a]], s));
    }
    inverse = sb_m3_transpose(sb_m3_inverse(jacobian));
    for (int a = 0; a < width && gradients; a++)
        gradients[a] = sb_m3_apply(inverse, sb_v3(slope[a][0], slope[a][1], slope[a][2]));
}

static sb_result regi_match_embed(const sb_mesh *mesh, const sb_vec3 *points, int count, const reg_match_def *def,
                                  sb_real size, sb_embedding **embedding, sb_error *error)
{
    sb_embedding_def embed = sb_default_embedding_def();
    embed.mesh = mesh;
    embed.points = points;
    embed.point_count = count;
    embed.kind = SB_EMBED_PLAIN;
    embed.max_distance = (sb_real)0.25 * size; /* beyond, the surface and the model are not of one organ */
    embed.allocator = def->allocator;
    embed.jobs = def->body->jobs;
    return sb_embedding_create(&embed, embedding, error);
}

/* Fills charges[count] and their rows, by ascending element. start: scratch [elements + 1], zeroed. */
static void regi_match_settle_points(const sb_embedding *embedding, const sb_mesh *mesh, int count, int *start,
                                     regi_match_charge *charges, sb_real *weights, sb_vec3 *gradients)
{
    size_t width = (size_t)sb_mesh_element_width(mesh);
    sb_embedded_point point;
    for (int i = 0; i < count; i++) {
        (void)sb_embedding_get_point(embedding, i, &point);
        start[point.element + 1]++;
    }
    for (int e = 0; e < mesh->element_count; e++)
        start[e + 1] += start[e];
    for (int i = 0; i < count; i++) {
        size_t at;
        (void)sb_embedding_get_point(embedding, i, &point);
        at = (size_t)start[point.element]++;
        charges[at].element = point.element;
        charges[at].index = i;
        charges[at].guess = -1;
        regi_match_weigh(mesh, &point, weights + at * width, gradients ? gradients + at * width : NULL);
    }
}

/* ---- memory ---- */

static void regi_match_layout(reg_match *match, sbi_arena *arena)
{
    size_t charges = (size_t)match->charge_count, all = charges + (size_t)match->landmark_count;
    size_t width = (size_t)match->width, nodes = (size_t)match->body->domain.node_count;
    match->charges = (regi_match_charge *)sbi_arena_take(arena, all, sizeof(regi_match_charge));
    match->weights = (sb_real *)sbi_arena_take(arena, all, width * sizeof(sb_real));
    match->gradients = (sb_vec3 *)sbi_arena_take(arena, charges, width * sizeof(sb_vec3));
    match->targets = (sb_vec3 *)sbi_arena_take(arena, (size_t)match->landmark_count, sizeof(sb_vec3));
    match->pull = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    match->trial = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    match->local = (sb_real *)sbi_arena_take(arena, 3 * width, 3 * width * sizeof(sb_real));
}

static sb_result regi_match_allocate(reg_match *match, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    regi_match_layout(match, &arena);
    match->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&match->allocator, arena.used, 1);
    if (!match->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a match of %d charges", match->charge_count);
    arena.base = (unsigned char *)match->memory;
    arena.used = 0;
    regi_match_layout(match, &arena);
    return SB_OK;
}

/* Charges and landmarks in the elements that hold them. */
static sb_result regi_match_hold(reg_match *match, const reg_match_def *def, const regi_match_sites *sites,
                                 sb_error *error)
{
    sb_mesh mesh = regi_match_mesh(match->body);
    size_t charges = (size_t)match->charge_count;
    for (int kind = 0; kind < 2; kind++) {
        const sb_vec3 *points = kind == 0 ? sites->points : def->landmarks;
        int count = kind == 0 ? match->charge_count : match->landmark_count;
        size_t first = kind == 0 ? 0 : charges;
        sb_embedding *embedding = NULL;
        int *start;
        sb_result result;
        if (count == 0)
            continue;
        result = regi_match_embed(&mesh, points, count, def, match->size, &embedding, error);
        if (result != SB_OK)
            return result;
        start = (int *)sbi_alloc_zeroed(&match->allocator, (size_t)mesh.element_count + 1, sizeof(int));
        if (start)
            regi_match_settle_points(embedding, &mesh, count, start, match->charges + first,
                                     match->weights + first * (size_t)match->width,
                                     kind == 0 ? match->gradients : NULL);
        sb_embedding_destroy(embedding);
        sbi_free(&match->allocator, start);
        if (!start)
            return sbi_fail(error, SB_ERROR_MEMORY, "no memory to sort %d points", count);
    }
    for (size_t i = 0; i < charges; i++) {
        regi_match_charge *charge = match->charges + i;
        sb_vec3 area = sites->areas[charge->index];
        charge->area = sb_v3_norm(area);
        charge->normal = sb_v3_scale((sb_real)1 / charge->area, area);
        match->total_area += (double)charge->area;
    }
    return SB_OK;
}

/* ---- life ---- */

static sb_result regi_match_make_field(reg_match *match, const reg_match_def *def, sb_error *error)
{
    reg_field_def field = reg_default_field_def();
    sb_mesh mesh = regi_match_mesh(match->body);
    field.kind = def->method == REG_PBSM_LAPLACE ? REG_FIELD_LAPLACE : REG_FIELD_DISTANCE;
    field.surface = def->target;
    field.points = def->target_points;
    field.normals = def->target_normals;
    field.point_count = def->target_count;
    field.cells = def->cells;
    field.allocator = def->allocator;
    field.jobs = match->body->jobs;
    sb_mesh_bounds(&mesh, &field.low, &field.high);
    return reg_field_create(&field, &match->field, error);
}

/* What charges are measured with: Young's modulus, as mean over the elements. */
static sb_real regi_match_young(const sb_body *body)
{
    double sum = 0;
    for (int e = 0; e < body->domain.cell_count; e++)
        sum += (double)sb_material_young(body->materials + body->cell_material[e]);
    return (sb_real)(sum / (double)body->domain.cell_count);
}

static sb_result regi_match_set(reg_match *match, const reg_match_def *def, sb_error *error)
{
    sb_mesh mesh = regi_match_mesh(def->body);
    sb_vec3 low, high;
    sb_real share; /* of an element in the cube of the organ's size: its cube root is the element's size */
    sb_mesh_bounds(&mesh, &low, &high);
    match->body = def->body;
    match->clock = def->clock;
    match->method = def->method;
    match->width = sb_mesh_element_width(&mesh);
    match->size = sb_v3_norm(sb_v3_sub(high, low));
    match->young = regi_match_young(def->body);
    if (!sb_is_finite(match->young) || !(match->young > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL, "the body's Young's modulus is %g", (double)match->young);
    match->rounding = (sb_real)0.5 * def->sampling * match->size;
    match->first_reach = def->reach * match->size;
    match->last_reach = sb_min(def->last_reach, def->reach) * match->size;
    match->least_cosine = def->least_cosine;
    match->least_active = def->least_active;
    match->first_charge = def->first_charge;
    match->last_charge = def->last_charge;
    match->least_growth = def->least_growth;
    match->most_growth = def->most_growth;
    match->settled = def->settled;
    match->max_seconds = def->max_seconds;
    match->landmark_count = def->landmark_count;
    share = sb_mesh_volume(&mesh) / ((sb_real)mesh.element_count * match->size * match->size * match->size);
    match->landmark_stiffness = def->landmark_stiffness * match->young * match->size * sb_exp(sb_log(share) / 3);
    return SB_OK;
}

static sb_result regi_match_build(reg_match *match, const reg_match_def *def, sb_error *error)
{
    regi_match_sites sites;
    sb_result result = regi_match_set(match, def, error);
    if (result == SB_OK)
        result = regi_match_make_field(match, def, error);
    if (result != SB_OK)
        return result;
    match->partial = def->partial == SB_AUTO ? regi_field_is_open(match->field) : def->partial;
    result = regi_match_find_sites(def, &sites, error);
    if (result != SB_OK)
        return result;
    match->charge_count = sites.count;
    result = regi_match_allocate(match, error);
    if (result == SB_OK)
        result = regi_match_hold(match, def, &sites, error);
    regi_match_free_sites(&def->allocator, &sites);
    if (result == SB_OK && match->landmark_count)
        memcpy(match->targets, def->landmark_targets, (size_t)match->landmark_count * sizeof(sb_vec3));
    return result;
}

REG_API sb_result reg_match_create(const reg_match_def *def, reg_match **match, sb_error *error)
{
    reg_match *made;
    sb_result result = regi_match_check(def, error);
    if (result == SB_OK && !match)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "there is no place for the match");
    if (result != SB_OK)
        return result;
    made = (reg_match *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a match");
    made->allocator = def->allocator;
    result = regi_match_build(made, def, error);
    if (result != SB_OK) {
        reg_match_destroy(made);
        return result;
    }
    reg_match_restart(made);
    *match = made;
    return SB_OK;
}

REG_API void reg_match_destroy(reg_match *match)
{
    sb_allocator allocator;
    if (!match)
        return;
    allocator = match->allocator;
    reg_field_destroy(match->field);
    sbi_free(&allocator, match->memory);
    sbi_free(&allocator, match);
}

REG_API void reg_match_restart(reg_match *match)
{
    double seconds = match->info.seconds;
    memset(&match->info, 0, sizeof match->info);
    match->info.seconds = seconds;
    match->info.charge = match->first_charge;
    match->info.error.line = 0;
    match->info.error.element = match->info.error.node = -1;
    match->charge = match->first_charge;
    match->reach = match->first_reach;
    match->last_mean = SB_REAL_MAX;
    match->calm = 0;
}

/* ---- landmarks and readings ---- */

REG_API sb_result reg_match_move_landmarks(reg_match *match, const sb_vec3 *targets)
{
    if (!match || (!targets && match->landmark_count))
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < match->landmark_count; i++)
        if (!sb_v3_is_finite(targets[i]))
            return SB_ERROR_NOT_FINITE;
    if (match->landmark_count)
        memcpy(match->targets, targets, (size_t)match->landmark_count * sizeof(sb_vec3));
    match->last_mean = SB_REAL_MAX;
    match->calm = 0;
    match->info.stop = REG_MATCH_RUNNING;
    return SB_OK;
}

REG_API void reg_match_landmarks(const reg_match *match, sb_vec3 *points)
{
    for (int i = match->charge_count; i < match->charge_count + match->landmark_count; i++)
        points[match->charges[i].index] = regi_match_point(match, i);
}

REG_API const sb_body *reg_match_body(const reg_match *match) { return match->body; }

REG_API reg_match_info reg_match_get_info(const reg_match *match) { return match->info; }

REG_API int reg_match_sample_count(const reg_match *match) { return match->charge_count; }

REG_API sb_result reg_match_get_sample(const reg_match *match, int index, reg_match_sample *sample)
{
    const regi_match_charge *charge;
    if (!match || !sample)
        return SB_ERROR_ARGUMENT;
    if (index < 0 || index >= match->charge_count)
        return SB_ERROR_INDEX;
    charge = match->charges + index;
    sample->point = charge->point;
    sample->area = charge->area;
    sample->distance = charge->distance;
    sample->active = charge->active;
    return SB_OK;
}

/* ==== src/register/match_step.c ==== */
/* match_step: one step of a match: look at the target, pull, solve, raise the charge. */
#include <string.h>


static double regi_match_now(const reg_match *match) { return match->clock ? match->clock() : 0.0; }

static const int *regi_match_nodes(const reg_match *match, int charge)
{
    return match->body->domain.cells + (size_t)match->charges[charge].element * (size_t)match->width;
}

REGI_API sb_vec3 regi_match_point(const reg_match *match, int charge)
{
    const int *nodes = regi_match_nodes(match, charge);
    const sb_real *weights = match->weights + (size_t)charge * (size_t)match->width;
    sb_vec3 x = sb_v3(0, 0, 0);
    for (int a = 0; a < match->width; a++)
        x = sb_v3_madd(x, weights[a], match->body->position[nodes[a]]);
    return x;
}

/* ---- looking at the target ---- */

/* The outward normal now: cof(F) N. Where the element is flat, the one at rest. */
static sb_vec3 regi_match_normal(const reg_match *match, int charge)
{
    const int *nodes = regi_match_nodes(match, charge);
    const sb_vec3 *gradients = match->gradients + (size_t)charge * (size_t)match->width;
    sb_vec3 rest = match->charges[charge].normal, r[3], normal;
    sb_mat3 f = sb_m3_zero();
    sb_real length;
    for (int a = 0; a < match->width; a++)
        f = sb_m3_add(f, sb_m3_outer(match->body->position[nodes[a]], gradients[a]));
    for (int c = 0; c < 3; c++)
        r[c] = sb_v3(f.m[0][c], f.m[1][c], f.m[2][c]);
    normal = sb_v3_scale(rest.x, sb_v3_cross(r[1], r[2]));
    normal = sb_v3_madd(normal, rest.y, sb_v3_cross(r[2], r[0]));
    normal = sb_v3_madd(normal, rest.z, sb_v3_cross(r[0], r[1]));
    length = sb_v3_norm(normal);
    return length > 0 ? sb_v3_scale((sb_real)1 / length, normal) : rest;
}

/* Distance potential, rounded off within r of the target: phi' = d/r there and 1 beyond, along the normal of the target
 * (of the organ, when the target's is not known). Beyond, its own second derivative is 0; 1/d in its place is the
 * curvature of the parabola that touches it from above, so that a step never goes too far. */
static void regi_match_feel_distance(const reg_match *match, regi_match_charge *charge, const reg_field_hit *hit,
                                     sb_vec3 normal)
{
    sb_real r = match->rounding, d, size;
    charge->line = sb_v3_dot(hit->normal, hit->normal) > 0 ? hit->normal : normal;
    d = sb_v3_dot(sb_v3_sub(charge->point, hit->point), charge->line);
    size = sb_abs(d);
    charge->stiffness = 1 / sb_max(r, size);
    charge->force = sb_v3_scale(d * charge->stiffness, charge->line);
    charge->energy = size < r ? (sb_real)0.5 * d * d / r : size - (sb_real)0.5 * r;
}

/* Laplace's: the slope along the organ's normal. What the grid's gradient has across it is noise of the cells, against
 * which nothing would hold the charge. */
static int regi_match_feel_grid(const reg_match *match, regi_match_charge *charge, sb_vec3 normal)
{
    reg_field_sample sample;
    if (!reg_field_along(match->field, charge->point, normal, 2 * match->rounding, -1, &sample))
        return 0;
    charge->line = normal;
    charge->energy = sample.phi;
    charge->force = sb_v3_scale(sample.phi_n, normal);
    charge->stiffness = sb_max(sample.phi_nn, sb_abs(sample.phi_n) / sb_max(match->rounding, charge->distance));
    return 1;
}

static void regi_match_look_at(reg_match *match, int index)
{
    regi_match_charge *charge = match->charges + index;
    sb_vec3 normal = regi_match_normal(match, index);
    reg_field_hit hit;
    charge->point = regi_match_point(match, index);
    charge->active = reg_field_closest(match->field, charge->point, charge->guess, &hit);
    if (!charge->active)
        return;
    charge->guess = hit.item;
    charge->distance = hit.distance;
    if (match->partial) {
        int known = sb_v3_dot(hit.normal, hit.normal) > 0;
        charge->active = !hit.on_border && hit.distance < match->reach &&
                         (!known || sb_v3_dot(normal, hit.normal) > match->least_cosine);
    }
    if (!charge->active)
        return;
    if (match->method == REG_PBSM_LAPLACE)
        charge->active = regi_match_feel_grid(match, charge, normal);
    else
        regi_match_feel_distance(match, charge, &hit, normal);
}

static void regi_match_look_chunk(void *user, int chunk)
{
    reg_match *match = (reg_match *)user;
    int first = chunk * REGI_MATCH_CHUNK, last = sbi_min_int(first + REGI_MATCH_CHUNK, match->charge_count);
    for (int i = first; i < last; i++)
        regi_match_look_at(match, i);
}

/* Sums over the charges, in their order. Returns the electric energy (J). */
static double regi_match_look(reg_match *match)
{
    double area = 0, mean = 0, energy = 0;
    sb_real most = 0;
    int chunks = (match->charge_count + REGI_MATCH_CHUNK - 1) / REGI_MATCH_CHUNK;
    sbi_run(&match->body->jobs, regi_match_look_chunk, match, chunks);
    for (int i = 0; i < match->charge_count; i++) {
        const regi_match_charge *charge = match->charges + i;
        if (!charge->active)
            continue;
        area += (double)charge->area;
        mean += (double)charge->area * (double)charge->distance;
        energy += (double)charge->area * (double)charge->energy;
        most = sb_max(most, charge->distance);
    }
    match->info.active = (sb_real)(area / match->total_area);
    match->info.mean_distance = area > 0 ? (sb_real)(mean / area) : 0;
    match->info.max_distance = most;
    return energy * (double)match->charge * (double)match->young;
}

/* ---- the system ---- */

/* Adds `scale` line line^T of one charge to the element's stiffness, of which the blocks from the diagonal to the right
 * are kept. */
static void regi_match_add_line(sb_real *local, int width, const sb_real *weights, sb_vec3 line, sb_real scale)
{
    sb_real v[3 * SB_MAX_ELEMENT_NODES];
    int size = 3 * width;
    for (int a = 0; a < width; a++) {
        v[3 * a] = weights[a] * line.x;
        v[3 * a + 1] = weights[a] * line.y;
        v[3 * a + 2] = weights[a] * line.z;
    }
    for (int i = 0; i < size; i++) {
        sb_real s = scale * v[i], *SB_RESTRICT row = local + i * size;
        for (int j = i - i % 3; j < size; j++)
            row[j] += s * v[j];
    }
}

static void regi_match_pull_nodes(reg_match *match, int index, sb_vec3 force)
{
    const int *nodes = regi_match_nodes(match, index);
    const sb_real *weights = match->weights + (size_t)index * (size_t)match->width;
    for (int a = 0; a < match->width; a++)
        match->pull[nodes[a]] = sb_v3_madd(match->pull[nodes[a]], weights[a], force);
}

/* The element's stiffness to its blocks of the matrix. */
static void regi_match_scatter(reg_match *match, int index)
{
    sb_matrix *matrix = &match->body->matrix;
    const int *nodes = regi_match_nodes(match, index);
    size_t size = 3 * (size_t)match->width;
    for (int a = 0; a < match->width; a++)
        for (int b = a; b < match->width; b++) {
            int at = sb_matrix_find(matrix, nodes[a], nodes[b]);
            sb_real *block = matrix->blocks[at], *mirror = matrix->blocks[matrix->transpose[at]];
            const sb_real *from = match->local + 3 * (size_t)a * size + 3 * (size_t)b;
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++) {
                    block[3 * i + j] += from[(size_t)i * size + (size_t)j];
                    if (b != a)
                        mirror[3 * j + i] += from[(size_t)i * size + (size_t)j];
                }
        }
}

/* Charges pull against the slope of the potential. */
static void regi_match_add_charges(reg_match *match)
{
    size_t bytes = 9 * (size_t)match->width * (size_t)match->width * sizeof(sb_real);
    sb_real q = match->charge * match->young;
    for (int i = 0; i < match->charge_count;) {
        int first = i, any = 0;
        memset(match->local, 0, bytes);
        for (; i < match->charge_count && match->charges[i].element == match->charges[first].element; i++) {
            const regi_match_charge *charge = match->charges + i;
            if (!charge->active)
                continue;
            any = 1;
            regi_match_pull_nodes(match, i, sb_v3_scale(-q * charge->area, charge->force));
            regi_match_add_line(match->local, match->width, match->weights + (size_t)i * (size_t)match->width,
                                charge->line, q * charge->area * charge->stiffness);
        }
        if (any)
            regi_match_scatter(match, first);
    }
}

/* Landmarks are springs to where they are seen. */
static void regi_match_add_landmarks(reg_match *match)
{
    size_t bytes = 9 * (size_t)match->width * (size_t)match->width * sizeof(sb_real);
    match->info.landmark_distance = 0;
    for (int i = match->charge_count; i < match->charge_count + match->landmark_count; i++) {
        sb_vec3 gap = sb_v3_sub(match->targets[match->charges[i].index], regi_match_point(match, i));
        memset(match->local, 0, bytes);
        for (int axis = 0; axis < 3; axis++)
            regi_match_add_line(match->local, match->width, match->weights + (size_t)i * (size_t)match->width,
                                sb_v3(axis == 0, axis == 1, axis == 2), match->landmark_stiffness);
        regi_match_pull_nodes(match, i, sb_v3_scale(match->landmark_stiffness, gap));
        regi_match_scatter(match, i);
        match->info.landmark_distance = sb_max(match->info.landmark_distance, sb_v3_norm(gap));
    }
}

/* Rigid motions that nothing holds would leave the matrix singular: this much stiffness is far below what a charge
 * adds. Source of the mass: any positive diagonal would do. */
static sb_real regi_match_mass_factor(const reg_match *match)
{
    sb_real mass = sb_body_mass(match->body);
    return mass > 0 ? (sb_real)1e-4 * match->young * match->size / mass : 0;
}

/* matrix and rhs of the step; supports go where they are to be. */
static sb_result regi_match_assemble(reg_match *match, sb_real *elastic)
{
    sb_body *b = match->body;
    int n = b->domain.node_count, bad = sbi_assembly_force(&b->assembly, b->displacement, b->internal);
    b->force_current = bad < 0;
    if (bad < 0)
        bad = sbi_assembly_energy(&b->assembly, b->displacement, elastic);
    if (bad >= 0)
        return sbi_fail_element(&match->info.error, SB_ERROR_INVERTED, bad,
                                "element %d is inside out, which its material does not allow", bad);
    sbi_assembly_tangent(&b->assembly, b->displacement, SB_TANGENT_QUASI, 1, &b->matrix);
    sbi_body_add_mass(b, regi_match_mass_factor(match));
    memset(match->pull, 0, (size_t)n * sizeof(sb_vec3));
    regi_match_add_charges(match);
    regi_match_add_landmarks(match);
    if (b->load_count) {
        sbi_loads_add_tangent(b, b->displacement, SB_TANGENT_QUASI, 1, &b->matrix);
        (void)sbi_loads_force(b, b->displacement, 1);
    }
    for (int i = 0; i < n; i++) {
        sb_vec3 force = sb_v3_add(sb_v3_sub(match->pull[i], b->internal[i]), b->dead_load[i]);
        force = sb_v3_madd(force, b->load_mass[i], b->gravity);
        b->rhs[i] = b->load_count ? sb_v3_add(force, b->follower[i]) : force;
        b->increment[i] = sbi_body_pick_axes(b->fixed[i], sb_v3_sub(b->target[i], b->displacement[i]), sb_v3(0, 0, 0));
    }
    return SB_OK;
}

static sb_result regi_match_solve(reg_match *match)
{
    sb_body *b = match->body;
    sb_pcg_options options = sb_default_pcg_options();
    sb_pcg_info pcg;
    sb_result result;
    memset(&pcg, 0, sizeof pcg);
    sb_matrix_constrain(&b->matrix, b->fixed, &b->increment[0].x, &b->rhs[0].x);
    result = sb_preconditioner_update(b->precond, &b->matrix, b->position, &match->info.error);
    if (result != SB_OK)
        return result;
    options.tolerance = 1e-2; /* the next step sees what is left */
    options.max_iterations = b->max_iterations;
    options.jobs = &b->jobs;
    result = sb_pcg_solve(&b->matrix, b->precond, &b->rhs[0].x, &b->increment[0].x, &options, &b->pcg, &pcg);
    match->info.pcg_iterations = pcg.iterations;
    if (result == SB_ERROR_NOT_CONVERGED)
        return SB_OK;
    return result == SB_OK ? SB_OK
                           : sbi_fail(&match->info.error, result, "the system of a match could not be solved");
}

/* ---- moving ---- */

/* Largest component of the increment; not finite when one is not. */
static sb_real regi_match_largest(const sb_body *b)
{
    sb_real most = 0;
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_real length = sb_v3_norm(b->increment[i]);
        if (!sb_is_finite(length))
            return length;
        most = sb_max(most, length);
    }
    return most;
}

/* Takes the increment, shortened so that no node moves more than a tenth of the organ's size, and until the material
 * admits the shape. */
static sb_result regi_match_move(reg_match *match)
{
    sb_body *b = match->body;
    sb_real largest = regi_match_largest(b), limit = (sb_real)0.1 * match->size, share, energy;
    int bad = 0;
    if (!sb_is_finite(largest))
        return sbi_fail(&match->info.error, SB_ERROR_DIVERGED, "the step of a match is not finite");
    share = largest > limit ? limit / largest : 1;
    for (int cut = 0; cut < 20; cut++, share *= (sb_real)0.5) {
        for (int i = 0; i < b->domain.node_count; i++)
            match->trial[i] = sb_v3_madd(b->displacement[i], share, b->increment[i]);
        bad = sbi_assembly_energy(&b->assembly, match->trial, &energy);
        if (bad < 0 && sb_is_finite(energy)) {
            match->info.change = share * largest;
            return sb_body_set_displacements(b, match->trial);
        }
    }
    return sbi_fail_element(&match->info.error, SB_ERROR_INVERTED, bad,
                            "element %d would turn inside out however short the step", bad);
}

/* ---- control ---- */

/* q <- q clamp(I_int / I_phi), and a partial target's reach shrinks. */
static void regi_match_raise(reg_match *match, double elastic, double electric)
{
    sb_real ratio = electric > 0 ? (sb_real)(elastic / electric) : match->most_growth;
    ratio = sb_max(match->least_growth, sb_min(ratio, match->most_growth));
    match->charge = sb_min(match->charge * ratio, match->last_charge);
    match->reach = sb_max(match->last_reach, (sb_real)0.93 * match->reach);
}

/* Three steps running at full charge and reach without a fall of the mean distance worth the name. */
static void regi_match_judge(reg_match *match)
{
    sb_real mean = match->info.mean_distance;
    int full = match->info.charge >= match->last_charge && (!match->partial || match->reach <= match->last_reach);
    match->calm = full && mean >= (1 - match->settled) * match->last_mean ? match->calm + 1 : 0;
    if (!(mean >= match->last_mean))
        match->last_mean = mean;
    match->info.stop = match->calm >= 3 ? REG_MATCH_SETTLED : REG_MATCH_RUNNING;
}

static sb_result regi_match_try(reg_match *match)
{
    double begin = regi_match_now(match), looked, assembled, electric = regi_match_look(match);
    sb_real elastic = 0;
    sb_result result;
    looked = regi_match_now(match);
    match->info.seconds_field = looked - begin;
    if (match->partial && match->info.active < match->least_active && match->landmark_count == 0)
        return sbi_fail(&match->info.error, SB_ERROR_NOT_CONVERGED, "only %.1f %% of the organ's surface is near the "
                        "target and faces as it does: align them first", 100 * (double)match->info.active);
    result = regi_match_assemble(match, &elastic);
    assembled = regi_match_now(match);
    match->info.seconds_system = assembled - looked;
    if (result == SB_OK)
        result = regi_match_solve(match);
    match->info.seconds_solve = regi_match_now(match) - assembled;
    if (result == SB_OK)
        result = regi_match_move(match);
    if (result != SB_OK)
        return result;
    match->info.charge = match->charge;
    regi_match_judge(match);
    regi_match_raise(match, (double)elastic, electric);
    match->info.iterations++;
    return SB_OK;
}

REG_API sb_result reg_match_step(reg_match *match, reg_match_info *info)
{
    sb_result result;
    double begin;
    if (!match)
        return SB_ERROR_ARGUMENT;
    begin = regi_match_now(match);
    memset(&match->info.error, 0, sizeof match->info.error);
    match->info.error.element = match->info.error.node = -1;
    if (match->body->elimination)
        result = sbi_fail(&match->info.error, SB_ERROR_UNSUPPORTED, "the body has constraints now");
    else
        result = regi_match_try(match);
    match->info.seconds += regi_match_now(match) - begin;
    if (result != SB_OK)
        match->info.stop = result == SB_ERROR_NOT_CONVERGED ? REG_MATCH_NO_OVERLAP : REG_MATCH_FAILED;
    if (info)
        *info = match->info;
    return result;
}

REG_API sb_result reg_match_run(reg_match *match, int steps, reg_match_info *info)
{
    sb_result result = SB_OK;
    if (!match || steps < 1)
        return SB_ERROR_ARGUMENT;
    match->info.stop = REG_MATCH_RUNNING;
    for (int i = 0; result == SB_OK && match->info.stop == REG_MATCH_RUNNING; i++) {
        if (i == steps)
            match->info.stop = REG_MATCH_STEP_CAP;
        else if (match->info.seconds >= match->max_seconds)
            match->info.stop = REG_MATCH_TIME_CAP;
        else
            result = reg_match_step(match, NULL);
    }
    if (info)
        *info = match->info;
    return result;
}

#endif /* REG_IMPLEMENTATION */

/* ==== src/register/../softbody/end.h ==== */
/* end: gives back the settings that begin.h changed. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT DEFAULT
#elif defined(__GNUC__)
#if !defined(__STRICT_ANSI__) && (defined(__FP_FAST_FMA) || defined(__FP_FAST_FMAF))
#pragma GCC pop_options
#endif
#endif

/*
softbody is available under two licences; choose the one you like.

------------------------------------------------------------------------------
ALTERNATIVE A - MIT License

Copyright (c) 2025 the softbody authors

Permission is hereby granted, free of charge, to any person obtaining a copy of
this software and associated documentation files (the "Software"), to deal in
the Software without restriction, including without limitation the rights to
use, copy, modify, merge, publish, distribute, sublicense, and/or sell copies
of the Software, and to permit persons to whom the Software is furnished to do
so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all
copies or substantial portions of the Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR
IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY,
FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
AUTHORS OR COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER
LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM,
OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE
SOFTWARE.

------------------------------------------------------------------------------
ALTERNATIVE B - Public Domain (www.unlicense.org)

This is free and unencumbered software released into the public domain.

Anyone is free to copy, modify, publish, use, compile, sell, or distribute this
software, either in source code form or as a compiled binary, for any purpose,
commercial or non-commercial, and by any means.

In jurisdictions that recognize copyright laws, the author or authors of this
software dedicate any and all copyright interest in the software to the public
domain. We make this dedication for the benefit of the public at large and to
the detriment of our heirs and successors. We intend this dedication to be an
overt act of relinquishment in perpetuity of all present and future rights to
this software under copyright law.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR
IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY,
FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
AUTHORS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN
ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION
WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE.
*/
