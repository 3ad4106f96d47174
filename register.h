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
#define reg_default_cpd_options reg_default_cpd_options_f32
#define reg_cpd_fit reg_cpd_fit_f32
#define reg_cpd_destroy reg_cpd_destroy_f32
#define reg_cpd_get_info reg_cpd_get_info_f32
#define reg_cpd_moved reg_cpd_moved_f32
#define reg_cpd_partners reg_cpd_partners_f32
#define reg_cpd_probabilities reg_cpd_probabilities_f32
#define reg_cpd_linear reg_cpd_linear_f32
#define reg_cpd_apply reg_cpd_apply_f32
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

/* ==== src/register/cpd.h ==== */
/* cpd: coherent point drift, which moves one point cloud onto another without knowing pairs. Floor 4.
 *
 *     reg_cpd_options options = reg_default_cpd_options();
 *     reg_cpd *fit = NULL;
 *     if (reg_cpd_fit(source, source_count, target, target_count, &options, &fit, &error) != SB_OK) ...
 *     reg_cpd_apply(fit, mesh.nodes, mesh.node_count, moved);      (whatever shall follow)
 *     reg_cpd_destroy(fit);
 *
 * The target's points are taken for draws from Gaussians of one width sigma around the moved source points, mixed with
 * a uniform share of outliers; expectation-maximisation lowers the negative log-likelihood of that, which never rises
 * (Myronenko and Song 2010). The clouds may differ in size. Each is first brought to mean 0 and root mean square
 * distance 1 from it, where beta, lambda and sigma^2 of the paper are at home; results are in the caller's units.
 * All is computed in double, in a float build, too: sigma^2 falls below what float resolves.
 *
 * The Gram matrix of the Gaussian kernel is factored once, G = L L^T by Cholesky with the largest remaining diagonal
 * entry as pivot, until none is above kernel_tolerance. That entry bounds every entry of G - L L^T; eigenpairs would do
 * with fewer columns, but cost more to find, and the deformation at other points would need all source points: so it
 * needs the pivots only. The rest is exact coherent point drift with the kernel L L^T. */
#ifndef REG_CPD_H
#define REG_CPD_H


typedef enum reg_cpd_kind {
    REG_CPD_RIGID = 0,      /* rotation, translation */
    REG_CPD_SIMILARITY = 1, /* rotation, translation, scale */
    REG_CPD_AFFINE = 2,
    REG_CPD_NONRIGID = 3    /* y + sum_k exp(-|y - c_k|^2 / 2 beta^2) w_k */
} reg_cpd_kind;

typedef enum reg_cpd_stop {
    REG_CPD_CONVERGED = 0,  /* the objective fell by no more than the tolerance */
    REG_CPD_EXACT = 1,      /* the clouds lie on each other: sigma fell to 1e-5 of the target's size */
    REG_CPD_ITERATIONS = 2, /* cap */
    REG_CPD_TIME = 3        /* cap */
} reg_cpd_stop;

/* How far a fit is, and how it ended. */
typedef struct reg_cpd_info {
    int iterations;        /* updates of the motion */
    int rank;              /* columns of the kernel's factor; 0 unless non-rigid */
    reg_cpd_stop stop;
    sb_real sigma;         /* m: distance, per coordinate, that is left between partners */
    sb_real explained;     /* expected number of target points that are no outliers */
    sb_real change;        /* fall of the objective in the last iteration, per target point */
    double objective;      /* negative log-likelihood (clouds of rms 1) + lambda/2 |L^T W|^2 + landmarks */
    double pairs;          /* pairs of points that were summed, all iterations together */
    double seconds;        /* with a clock, otherwise 0 */
    double kernel_seconds; /* of these for factoring the kernel */
} reg_cpd_info;

/* How to fit. Start from reg_default_cpd_options(). */
typedef struct reg_cpd_options {
    reg_cpd_kind kind;        /* default non-rigid */
    sb_real outliers;         /* w: expected share of target points without partner, in [0, 1); default 0.1 */
    sb_real beta;             /* width of the kernel over the source's rms size, in [1e-6, 1e6]; default 2, the paper's:
                               * smaller is less stiff */
    sb_real lambda;           /* price of deformation, in [1e-12, 1e12]; default 3, the paper's. For organs of a few
                               * thousand points beta 0.7 and lambda 1000 did best */
    int shared_frame;         /* 1: both clouds are measured by the source's mean and size, which keeps a rough
                               * alignment as start (take it for partial clouds). 0 (default): each by its own; kind
                               * rigid takes the source's size for both in any case */
    sb_real start_sigma;      /* m; 0 (default): from the mean squared distance of all pairs. That lets a soft source
                               * collapse and unfold another way round: after a rough alignment take what it left */
    sb_real kernel_tolerance; /* in (1e-12, 1); default 1e-4 */
    int max_rank;             /* columns of the kernel's factor at most; default 1000. With a smaller number than the
                               * tolerance needs, deformation is made of the smoothest modes */
    sb_real sum_tolerance;    /* share of each target point's probability that sums may leave out, in [0, 0.1]; 0: none
                               * is. Default 1e-5 */
    sb_real tolerance;        /* >= 0: ends when an iteration lowers the objective per target point by no more; 1e-6 */
    int max_iterations;       /* >= 0; default 300; 0 only pairs */
    double max_seconds;       /* looked at after each iteration; 0 (default): no cap; needs the clock */
    double max_pairs;         /* source points times target points; larger clouds are refused: thin them. 4e8 */

    int landmark_count;              /* known partners, >= 0 */
    const int *landmark_points;      /* [landmark_count] of the source; borrowed during the call */
    const sb_vec3 *landmark_targets; /* [landmark_count] m, where they are seen */
    sb_real landmark_sigma;          /* m, > 0: how sure that is */

    int (*progress)(void *user, const reg_cpd_info *info); /* after each iteration, by the caller's thread; a result
                                                            * other than 0 cancels. Default NULL */
    void *progress_user;
    sb_clock clock;           /* default NULL */
    sb_allocator allocator;   /* default malloc */
    sb_jobs jobs;             /* default inline; any gives the same bits */
    unsigned cookie;          /* set by reg_default_cpd_options; options made without it are refused */
} reg_cpd_options;

REG_API reg_cpd_options reg_default_cpd_options(void);

/* What was fitted. */
typedef struct reg_cpd reg_cpd;

/* Moves source onto target.
 * source, target  [count] (m), at least one point each, in any order; copied
 * options         NULL: defaults
 * fit             made on success; the caller's, for reg_cpd_destroy; untouched otherwise
 * A cap that was reached is no error: info.stop tells, and the fit is as good as it got.
 * Cost of an iteration: at most source_count target_count exponentials (about 5 ns each), and as sigma shrinks those of
 * near blocks of points only; non-rigid in addition source_count rank^2 / 2 + rank^3 / 6 multiply-adds. Memory: rank
 * (source_count + rank) doubles. The same bits for any jobs.
 * SB_ERROR_ARGUMENT (also a landmark of no point: error->node is its index), _NOT_FINITE (error->node; the message
 * names the cloud), _UNSUPPORTED (more than max_pairs), _CANCELLED, _NOT_CONVERGED (no target point is near enough any
 * source point to be more than an outlier), _MEMORY. */
REG_API sb_result reg_cpd_fit(const sb_vec3 *source, int source_count, const sb_vec3 *target, int target_count,
                              const reg_cpd_options *options, reg_cpd **fit, sb_error *error);
REG_API void reg_cpd_destroy(reg_cpd *fit); /* NULL is fine */

REG_API reg_cpd_info reg_cpd_get_info(const reg_cpd *fit);
/* The source where it was moved to: [source_count] (m), in its order; the fit's. */
REG_API const sb_vec3 *reg_cpd_moved(const reg_cpd *fit);
/* For each source point the target point that is most probably its partner, -1 where all probabilities are 0; the
 * fit's. Several source points may name one target point: compare probabilities. */
REG_API const int *reg_cpd_partners(const reg_cpd *fit);
/* [source_count] the probability of that: that the target point was drawn from this source point. */
REG_API const sb_real *reg_cpd_probabilities(const reg_cpd *fit);
/* x -> linear x + translation (m) of kinds rigid, similarity and affine; of non-rigid what the frames of the clouds
 * make of a point far from the source. */
REG_API void reg_cpd_linear(const reg_cpd *fit, sb_mat3 *linear, sb_vec3 *translation);
/* moved[count]: where the points (m) go; in place is fine. `rank` exponentials for each point. Nothing happens for
 * NULL. Points that are not finite give NaN. Thread-safe. */
REG_API void reg_cpd_apply(const reg_cpd *fit, const sb_vec3 *points, int count, sb_vec3 *moved);

#endif /* REG_CPD_H */

#endif /* REGISTER_H */

#if defined(REG_IMPLEMENTATION) && !defined(REG_IMPLEMENTATION_DONE)
#define REG_IMPLEMENTATION_DONE

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

/* ==== src/register/cpd_state.h ==== */
/* cpd_state: what coherent point drift shares among its parts. Internal: cpd_sums.c finds expected partners,
 * cpd_kernel.c factors the kernel and solves for the deformation, cpd.c iterates. All in the frames of the clouds. */
#ifndef REGI_CPD_STATE_H
#define REGI_CPD_STATE_H


enum {
    REGI_CPD_LANES = 16, /* points of a block: a loop of fixed length, which compilers vectorise at -O2 */
    REGI_CPD_CHUNKS = 8  /* parts of the target with sums of their own: tasks, whatever the number of threads */
};

/* Coordinates of a block of points. The last block is filled up with its last point. */
typedef struct regi_cpd_block {
    double x[REGI_CPD_LANES], y[REGI_CPD_LANES], z[REGI_CPD_LANES];
} regi_cpd_block;

typedef struct regi_cpd_box {
    double low[3], high[3];
} regi_cpd_box;

/* A cloud in an order that keeps neighbours together. */
typedef struct regi_cpd_cloud {
    int count, blocks;
    int *order;             /* [count] the caller's index of each point */
    regi_cpd_block *points; /* [blocks] */
    regi_cpd_box *boxes;    /* [blocks] */
} regi_cpd_cloud;

/* What a block of source points gathers: sum_n P_mn, and sum_n P_mn (x_n - T y_m), which keeps digits that the sum of
 * P x loses once sigma is small. */
typedef struct regi_cpd_sums {
    double p[REGI_CPD_LANES], x[REGI_CPD_LANES], y[REGI_CPD_LANES], z[REGI_CPD_LANES];
} regi_cpd_sums;

typedef struct regi_cpd_totals {
    double explained; /* sum P */
    double squares;   /* sum P |x_n - T y_m|^2 */
    double logs;      /* sum_n -log(sum_m exp(-|x_n - T y_m|^2 / 2 s2) + c) */
    double pairs;
} regi_cpd_totals;

/* Most probable partner of each source point. */
typedef struct regi_cpd_best {
    double probability[REGI_CPD_LANES];
    int target[REGI_CPD_LANES]; /* the caller's index, or -1 */
} regi_cpd_best;

/* One evaluation of all P_mn. */
typedef struct regi_cpd_expectation {
    const regi_cpd_cloud *target;
    const regi_cpd_cloud *source;  /* boxes: of the moved points */
    const regi_cpd_block *moved;   /* [source blocks] */
    double sigma2, outlier;        /* outlier: c, in the sum beside the Gaussians */
    double tolerance;              /* share of each target point that may be left out */
    regi_cpd_sums *sums;           /* [CHUNKS][source blocks]; the first row becomes the result */
    regi_cpd_totals totals[REGI_CPD_CHUNKS]; /* likewise */
    double (*terms)[REGI_CPD_LANES]; /* [CHUNKS][source blocks] */
    int *near_blocks;              /* [CHUNKS][source blocks] */
    regi_cpd_best *best;           /* [source blocks], or NULL: not wanted */
} regi_cpd_expectation;

/* The factor of the kernel, G = L L^T to the tolerance, by columns. */
typedef struct regi_cpd_kernel {
    sb_allocator allocator;
    int rank, capacity;
    size_t rows;         /* source points, filled up to whole blocks; those rows are 0 */
    double inverse;      /* 1 / (2 beta^2) */
    double *columns;     /* [capacity][rows] */
    int *pivots;         /* [capacity] rows */
    double *diagonal;    /* [rows] what is left of the diagonal; -1: a pivot */
    double *system;      /* [rank][stride] L^T P L + lambda s2, then its Cholesky factor, lower half */
    double *scaled;      /* [rank][REGI_CPD_SLICE] */
    size_t stride;
    double *weights[3];  /* [stride] c: T = Y + L c */
} regi_cpd_kernel;

#if defined(REG_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* Fills sums, totals[0] and best. Allocates nothing. */
REGI_API void regi_cpd_expect(regi_cpd_expectation *e, const sb_jobs *jobs);
REGI_API void regi_cpd_bound(const regi_cpd_block *points, int blocks, regi_cpd_box *boxes);

/* Factors the kernel of `points`, until the largest remaining diagonal entry is within tolerance or at max_rank
 * columns. On failure (SB_ERROR_MEMORY) free it, too. */
REGI_API sb_result regi_cpd_kernel_create(const regi_cpd_cloud *source, double beta, double tolerance, int max_rank,
                                          const sb_allocator *allocator, regi_cpd_kernel *kernel, sb_error *error);
REGI_API void regi_cpd_kernel_free(regi_cpd_kernel *kernel);
/* weights = (L^T P L + ridge)^-1 L^T r; p[rows], r[3][rows] in the order of the source. Returns |weights|^2. */
REGI_API double regi_cpd_kernel_solve(regi_cpd_kernel *kernel, const double *p, double *const r[3], double ridge,
                                      const sb_jobs *jobs);
/* a = l l^T in place, lower half, by strips of columns; a is known to be at least `ridge` above singular. */
REGI_API void regi_cpd_factor(double *a, int n, size_t stride, double ridge);
/* b becomes (l l^T)^-1 b. */
REGI_API void regi_cpd_back_solve(const double *l, int n, size_t stride, double *b);
/* moved = points + L weights. */
REGI_API void regi_cpd_kernel_move(const regi_cpd_kernel *kernel, const regi_cpd_block *points, regi_cpd_block *moved);
/* weights become those of the Gaussians at the pivots. */
REGI_API void regi_cpd_kernel_spread(regi_cpd_kernel *kernel);
#endif

#endif /* REGI_CPD_STATE_H */

/* ==== src/register/cpd_sums.c ==== */
/* cpd_sums: the expectation step, P_mn = exp(-|x_n - T y_m|^2 / 2 s2) / (sum_k exp(-|x_n - T y_k|^2 / 2 s2) + c).
 *
 * Both clouds lie in blocks of neighbours. For a block of the target, blocks of the source are left out whose share of
 * every P is small for certain, by the distances of boxes; all others are summed in loops over whole blocks. That is
 * faster than a search tree with its single points, needs none for the source, which moves, and the bound holds without
 * a guess of the width: a term left out is below tolerance / M of the largest term, or of c. */

#include <string.h>

/* e^x for x <= 0 to 1e-11 of it (below -700: e^-700), of operations that vectorise: 2^n 2^f with n in the low bits of
 * a sum with 1.5 2^52. */
SBI_FORCE_INLINE double regi_cpd_exp(double x)
{
    double t = (x > -700.0 ? x : -700.0) * 1.4426950408889634, n = t + 6755399441055744.0;
    double f = t - (n - 6755399441055744.0), p;
    p = 1.3215486790144307e-6 + f * 1.0178086009239699e-7;
    p = 1.5403530393381608e-4 + f * (1.5252733804059841e-5 + f * p);
    p = 9.618129107628477e-3 + f * (1.3333558146428443e-3 + f * p);
    p = 2.402265069591007e-1 + f * (5.550410866482158e-2 + f * p);
    p = 1.0 + f * (6.931471805599453e-1 + f * p);
    return sbi_dense_from_bits(sbi_dense_bits(p) + (sbi_dense_bits(n) << 52));
}

REGI_API void regi_cpd_bound(const regi_cpd_block *points, int blocks, regi_cpd_box *boxes)
{
    for (int b = 0; b < blocks; b++)
        for (int axis = 0; axis < 3; axis++) {
            const double *x = axis == 0 ? points[b].x : axis == 1 ? points[b].y : points[b].z;
            double low = x[0], high = x[0];
            for (int l = 1; l < REGI_CPD_LANES; l++) {
                low = x[l] < low ? x[l] : low;
                high = x[l] > high ? x[l] : high;
            }
            boxes[b].low[axis] = low;
            boxes[b].high[axis] = high;
        }
}

/* Squares of the smallest and the largest distance between points of two boxes. */
static void regi_cpd_box_distances(const regi_cpd_box *a, const regi_cpd_box *b, double *least, double *most)
{
    double near_sum = 0, far_sum = 0;
    for (int axis = 0; axis < 3; axis++) {
        double up = b->high[axis] - a->low[axis], down = a->high[axis] - b->low[axis];
        double gap = -up > -down ? -up : -down, reach = up > down ? up : down;
        near_sum += gap > 0 ? gap * gap : 0.0;
        far_sum += reach * reach;
    }
    *least = near_sum;
    *most = far_sum;
}

/* Blocks of the source that count for a block of the target; returns how many. */
static int regi_cpd_find_near(const regi_cpd_expectation *e, const regi_cpd_box *box, int *blocks)
{
    double width = 2 * e->sigma2, limit = 1.7976931348623157e308, least, most;
    double share = e->tolerance > 0 ? sbi_dense_log((double)e->source->count / e->tolerance) : 0.0;
    int count = 0;
    if (e->tolerance > 0) {
        for (int b = 0; b < e->source->blocks; b++) {
            regi_cpd_box_distances(box, e->source->boxes + b, &least, &most);
            limit = most < limit ? most : limit;
        }
        limit += width * share;
        if (e->outlier > 0 && e->outlier < 1) { /* a point that is near has most of its probability */
            double alone = width * (share - sbi_dense_log(e->outlier));
            limit = alone < limit ? alone : limit;
        }
    }
    for (int b = 0; b < e->source->blocks; b++) {
        regi_cpd_box_distances(box, e->source->boxes + b, &least, &most);
        if (least <= limit)
            blocks[count++] = b;
    }
    return count;
}

/* terms = squared distances; returns the smallest. */
static double regi_cpd_distances(const regi_cpd_block *moved, const int *blocks, int count, const double at[3],
                                 double (*SB_RESTRICT terms)[REGI_CPD_LANES])
{
    double low[REGI_CPD_LANES], least;
    for (int l = 0; l < REGI_CPD_LANES; l++)
        low[l] = 1.7976931348623157e308;
    for (int i = 0; i < count; i++) {
        const regi_cpd_block *block = moved + blocks[i];
        double *SB_RESTRICT out = terms[i];
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            double x = at[0] - block->x[l], y = at[1] - block->y[l], z = at[2] - block->z[l], d = x * x + y * y + z * z;
            out[l] = d;
            low[l] = d < low[l] ? d : low[l];
        }
    }
    least = low[0];
    for (int l = 1; l < REGI_CPD_LANES; l++)
        least = low[l] < least ? low[l] : least;
    return least;
}

/* terms = exp((least - terms) / 2 s2), 0 for what fills up the last block; returns their sum. */
static double regi_cpd_exponentials(const regi_cpd_expectation *e, double least, const int *blocks, int count,
                                    double (*SB_RESTRICT terms)[REGI_CPD_LANES])
{
    double sums[REGI_CPD_LANES], sum = 0, scale = 1 / (2 * e->sigma2);
    int used = e->source->count - (e->source->blocks - 1) * REGI_CPD_LANES;
    for (int l = 0; l < REGI_CPD_LANES; l++)
        sums[l] = 0;
    for (int i = 0; i < count; i++) {
        double *SB_RESTRICT out = terms[i];
        for (int l = 0; l < REGI_CPD_LANES; l++)
            out[l] = regi_cpd_exp((least - out[l]) * scale);
        if (blocks[i] == e->source->blocks - 1)
            for (int l = used; l < REGI_CPD_LANES; l++)
                out[l] = 0;
        for (int l = 0; l < REGI_CPD_LANES; l++)
            sums[l] += out[l];
    }
    for (int l = 0; l < REGI_CPD_LANES; l++)
        sum += sums[l];
    return sum;
}

/* Adds P of one target point, factor terms, to the sums; returns sum P |x - T|^2. */
static double regi_cpd_gather(const regi_cpd_block *moved, const int *blocks, int count, const double at[3],
                              double factor, double (*SB_RESTRICT terms)[REGI_CPD_LANES],
                              regi_cpd_sums *SB_RESTRICT sums)
{
    double squares[REGI_CPD_LANES], sum = 0;
    for (int l = 0; l < REGI_CPD_LANES; l++)
        squares[l] = 0;
    for (int i = 0; i < count; i++) {
        const regi_cpd_block *block = moved + blocks[i];
        regi_cpd_sums *SB_RESTRICT out = sums + blocks[i];
        const double *SB_RESTRICT term = terms[i];
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            double p = factor * term[l], x = at[0] - block->x[l], y = at[1] - block->y[l], z = at[2] - block->z[l];
            out->p[l] += p;
            out->x[l] += p * x;
            out->y[l] += p * y;
            out->z[l] += p * z;
            squares[l] += p * (x * x + y * y + z * z);
        }
    }
    for (int l = 0; l < REGI_CPD_LANES; l++)
        sum += squares[l];
    return sum;
}

static void regi_cpd_compare(const int *blocks, int count, int target, double factor,
                             double (*SB_RESTRICT terms)[REGI_CPD_LANES], regi_cpd_best *best)
{
    for (int i = 0; i < count; i++) {
        regi_cpd_best *b = best + blocks[i];
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            double p = factor * terms[i][l];
            if (p > b->probability[l] || (p > 0 && p == b->probability[l] && target < b->target[l])) {
                b->probability[l] = p;
                b->target[l] = target;
            }
        }
    }
}

/* One target point. The largest term is made 1, so that a point far from all still has partners when c is 0. */
static void regi_cpd_take(regi_cpd_expectation *e, int chunk, int index, int count)
{
    const regi_cpd_block *block = e->target->points + index / REGI_CPD_LANES;
    int lane = index % REGI_CPD_LANES;
    size_t first = (size_t)chunk * (size_t)e->source->blocks;
    const int *blocks = e->near_blocks + first;
    double (*terms)[REGI_CPD_LANES] = e->terms + first;
    double at[3], least, sum, depth, factor;
    regi_cpd_totals *totals = e->totals + chunk;
    at[0] = block->x[lane], at[1] = block->y[lane], at[2] = block->z[lane];
    least = regi_cpd_distances(e->moved, blocks, count, at, terms);
    depth = least / (2 * e->sigma2);
    if (e->outlier > 0 && (count == 0 || depth > 700)) { /* below anything that can be told from 0 beside c */
        totals->logs -= sbi_dense_log(e->outlier);
        return;
    }
    sum = regi_cpd_exponentials(e, least, blocks, count, terms);
    if (e->outlier > 0) {
        double size = sbi_dense_exp(-depth), whole = size * sum + e->outlier;
        factor = size / whole;
        totals->logs -= sbi_dense_log(whole);
    } else {
        factor = 1 / sum;
        totals->logs += depth - sbi_dense_log(sum);
    }
    totals->explained += factor * sum;
    totals->pairs += (double)(count * REGI_CPD_LANES);
    totals->squares += regi_cpd_gather(e->moved, blocks, count, at, factor, terms, e->sums + first);
    if (e->best)
        regi_cpd_compare(blocks, count, e->target->order[index], factor, terms, e->best);
}

static void regi_cpd_expect_chunk(void *user, int chunk)
{
    regi_cpd_expectation *e = (regi_cpd_expectation *)user;
    size_t first = (size_t)chunk * (size_t)e->source->blocks;
    int chunks = e->best ? 1 : REGI_CPD_CHUNKS; /* partners are kept once */
    int begin = (int)((int64_t)e->target->blocks * chunk / chunks);
    int end = (int)((int64_t)e->target->blocks * (chunk + 1) / chunks);
    memset(e->sums + first, 0, (size_t)e->source->blocks * sizeof(regi_cpd_sums));
    memset(e->totals + chunk, 0, sizeof(regi_cpd_totals));
    if (chunk >= chunks)
        return;
    for (int b = begin; b < end; b++) {
        int count = regi_cpd_find_near(e, e->target->boxes + b, e->near_blocks + first);
        int last = sbi_min_int((b + 1) * REGI_CPD_LANES, e->target->count);
        for (int i = b * REGI_CPD_LANES; i < last; i++)
            regi_cpd_take(e, chunk, i, count);
    }
}

REGI_API void regi_cpd_expect(regi_cpd_expectation *e, const sb_jobs *jobs)
{
    int blocks = e->source->blocks;
    for (int b = 0; e->best && b < blocks; b++)
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            e->best[b].probability[l] = 0;
            e->best[b].target[l] = -1;
        }
    sbi_run(jobs, regi_cpd_expect_chunk, e, REGI_CPD_CHUNKS);
    for (int chunk = 1; chunk < REGI_CPD_CHUNKS; chunk++) {
        const regi_cpd_sums *from = e->sums + (size_t)chunk * (size_t)blocks;
        e->totals[0].explained += e->totals[chunk].explained;
        e->totals[0].squares += e->totals[chunk].squares;
        e->totals[0].logs += e->totals[chunk].logs;
        e->totals[0].pairs += e->totals[chunk].pairs;
        for (int b = 0; b < blocks; b++)
            for (int l = 0; l < REGI_CPD_LANES; l++) {
                e->sums[b].p[l] += from[b].p[l];
                e->sums[b].x[l] += from[b].x[l];
                e->sums[b].y[l] += from[b].y[l];
                e->sums[b].z[l] += from[b].z[l];
            }
    }
}

/* ==== src/register/cpd_kernel.c ==== */
/* cpd_kernel: the factor of the Gaussian kernel, and the system for the deformation.
 *
 * With G = L L^T the system of the paper, (P G + lambda s2) W = r with r = P X - P Y, is met by T = Y + L c with
 * (L^T P L + lambda s2) c = L^T r: symmetric and positive definite, and points without partners (P = 0) need no
 * division. c = L^T W, so |c|^2 is the regularising term tr(W^T G W). */

#include <string.h>

enum {
    REGI_CPD_FIRST = 64,  /* columns that are made room for at first */
    REGI_CPD_SLICE = 512, /* rows of L that are weighted at a time: all columns of a slice stay in the cache */
    REGI_CPD_STRIP = 32,  /* rows of the system per task, and per step of its factorisation */
    REGI_CPD_FOUR = 4     /* lanes of a sum of products */
};

static double regi_cpd_gauss(const double a[3], double x, double y, double z, double inverse)
{
    double dx = a[0] - x, dy = a[1] - y, dz = a[2] - z;
    return sbi_dense_exp(-(dx * dx + dy * dy + dz * dz) * inverse);
}

static double regi_cpd_not_below_0(double x) { return x > 0 ? x : 0.0; }

/* sum a_i b_i; count is a multiple of REGI_CPD_FOUR. */
static double regi_cpd_dot(const double *a, const double *b, size_t count)
{
    double sum[REGI_CPD_FOUR] = {0, 0, 0, 0};
    for (size_t i = 0; i < count; i += REGI_CPD_FOUR)
        for (int l = 0; l < REGI_CPD_FOUR; l++)
            sum[l] += a[i + (size_t)l] * b[i + (size_t)l];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* out += s a over whole blocks. */
static void regi_cpd_add(double *SB_RESTRICT out, double s, const double *SB_RESTRICT a, size_t count)
{
    for (size_t i = 0; i < count; i += REGI_CPD_LANES)
        for (int l = 0; l < REGI_CPD_LANES; l++)
            out[i + (size_t)l] += s * a[i + (size_t)l];
}

/* ---- factor ---- */

REGI_API void regi_cpd_kernel_free(regi_cpd_kernel *kernel)
{
    sbi_free(&kernel->allocator, kernel->columns);
    sbi_free(&kernel->allocator, kernel->pivots);
    sbi_free(&kernel->allocator, kernel->diagonal);
    sbi_free(&kernel->allocator, kernel->system);
    sbi_free(&kernel->allocator, kernel->scaled);
    sbi_free(&kernel->allocator, kernel->weights[0]);
}

static int regi_cpd_grow(regi_cpd_kernel *kernel, int capacity)
{
    size_t old = (size_t)kernel->rank * kernel->rows;
    double *columns = kernel->rows <= SIZE_MAX / sizeof(double)
                          ? (double *)sbi_alloc(&kernel->allocator, (size_t)capacity, kernel->rows * sizeof(double))
                          : NULL;
    int *pivots = (int *)sbi_alloc(&kernel->allocator, (size_t)capacity, sizeof(int));
    if (!columns || !pivots) {
        sbi_free(&kernel->allocator, columns);
        sbi_free(&kernel->allocator, pivots);
        return 0;
    }
    if (old > 0) {
        memcpy(columns, kernel->columns, old * sizeof(double));
        memcpy(pivots, kernel->pivots, (size_t)kernel->rank * sizeof(int));
    }
    sbi_free(&kernel->allocator, kernel->columns);
    sbi_free(&kernel->allocator, kernel->pivots);
    kernel->columns = columns;
    kernel->pivots = pivots;
    kernel->capacity = capacity;
    return 1;
}

/* The row with the largest remaining diagonal entry above tolerance, of equal ones the first; -1: none. */
static int regi_cpd_next_pivot(const regi_cpd_kernel *kernel, int count, double tolerance)
{
    double most = tolerance;
    int pivot = -1;
    for (int i = 0; i < count; i++)
        if (kernel->diagonal[i] > most) {
            most = kernel->diagonal[i];
            pivot = i;
        }
    return pivot;
}

/* Column `rank` of the factor: what the columns before leave of the pivot's column of G. */
static void regi_cpd_add_column(regi_cpd_kernel *kernel, const regi_cpd_cloud *source, int pivot)
{
    const regi_cpd_block *home = source->points + pivot / REGI_CPD_LANES;
    double *column = kernel->columns + (size_t)kernel->rank * kernel->rows;
    double root = sqrt(kernel->diagonal[pivot]), at[3];
    at[0] = home->x[pivot % REGI_CPD_LANES], at[1] = home->y[pivot % REGI_CPD_LANES];
    at[2] = home->z[pivot % REGI_CPD_LANES];
    for (int b = 0; b < source->blocks; b++)
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            const regi_cpd_block *p = source->points + b;
            column[(size_t)b * REGI_CPD_LANES + (size_t)l] =
                regi_cpd_gauss(at, p->x[l], p->y[l], p->z[l], kernel->inverse);
        }
    for (int j = 0; j < kernel->rank; j++) {
        const double *before = kernel->columns + (size_t)j * kernel->rows;
        regi_cpd_add(column, -before[pivot], before, kernel->rows);
    }
    for (size_t i = 0; i < kernel->rows; i++)
        column[i] = i < (size_t)source->count ? column[i] / root : 0.0;
    for (int i = 0; i < source->count; i++)
        if (kernel->diagonal[i] >= 0)
            kernel->diagonal[i] = regi_cpd_not_below_0(kernel->diagonal[i] - column[i] * column[i]);
    for (int j = 0; j < kernel->rank; j++)
        column[kernel->pivots[j]] = 0; /* but for rounding it is */
    column[pivot] = root;
    kernel->diagonal[pivot] = -1;
    kernel->pivots[kernel->rank++] = pivot;
}

/* Memory for the systems of a kernel of known rank. */
static int regi_cpd_kernel_room(regi_cpd_kernel *kernel)
{
    size_t rank = (size_t)kernel->rank, stride = (rank + REGI_CPD_FOUR - 1) / REGI_CPD_FOUR * REGI_CPD_FOUR;
    kernel->stride = stride;
    kernel->system = (double *)sbi_alloc_zeroed(&kernel->allocator, rank, stride * sizeof(double));
    kernel->scaled = (double *)sbi_alloc(&kernel->allocator, rank, REGI_CPD_SLICE * sizeof(double));
    kernel->weights[0] = (double *)sbi_alloc_zeroed(&kernel->allocator, 3 * stride, sizeof(double));
    if (!kernel->system || !kernel->scaled || !kernel->weights[0])
        return 0;
    kernel->weights[1] = kernel->weights[0] + stride;
    kernel->weights[2] = kernel->weights[1] + stride;
    return 1;
}

REGI_API sb_result regi_cpd_kernel_create(const regi_cpd_cloud *source, double beta, double tolerance, int max_rank,
                                          const sb_allocator *allocator, regi_cpd_kernel *kernel, sb_error *error)
{
    int most = sbi_min_int(max_rank, source->count), pivot = 0, fits;
    memset(kernel, 0, sizeof *kernel);
    kernel->allocator = *allocator;
    kernel->rows = (size_t)source->blocks * REGI_CPD_LANES;
    kernel->inverse = 1 / (2 * beta * beta);
    kernel->diagonal = (double *)sbi_alloc(allocator, kernel->rows, sizeof(double));
    fits = kernel->diagonal != NULL;
    for (size_t i = 0; fits && i < kernel->rows; i++)
        kernel->diagonal[i] = 1;
    while (fits && kernel->rank < most && pivot >= 0) {
        if (kernel->rank == kernel->capacity)
            fits = regi_cpd_grow(kernel, kernel->rank > most / 2 ? most
                                         : kernel->rank > 0      ? 2 * kernel->rank
                                                                 : sbi_min_int(most, REGI_CPD_FIRST));
        pivot = fits ? regi_cpd_next_pivot(kernel, source->count, tolerance) : -1;
        if (pivot >= 0)
            regi_cpd_add_column(kernel, source, pivot);
    }
    if (fits && regi_cpd_kernel_room(kernel))
        return SB_OK;
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d columns of the kernel of %d points", kernel->rank + 1,
                    source->count);
}

/* ---- system ---- */

/* Products of rows a, a2 with rows b, b2 over `count` entries, a multiple of REGI_CPD_FOUR. */
static void regi_cpd_tile(const double *SB_RESTRICT a, const double *SB_RESTRICT a2, const double *SB_RESTRICT b,
                          const double *SB_RESTRICT b2, size_t count, double out[4])
{
    double s[4][REGI_CPD_FOUR];
    for (int l = 0; l < REGI_CPD_FOUR; l++)
        s[0][l] = s[1][l] = s[2][l] = s[3][l] = 0;
    for (size_t i = 0; i < count; i += REGI_CPD_FOUR)
        for (int l = 0; l < REGI_CPD_FOUR; l++) {
            double p = a[i + (size_t)l], p2 = a2[i + (size_t)l], q = b[i + (size_t)l], q2 = b2[i + (size_t)l];
            s[0][l] += p * q;
            s[1][l] += p * q2;
            s[2][l] += p2 * q;
            s[3][l] += p2 * q2;
        }
    for (int k = 0; k < 4; k++)
        out[k] = (s[k][0] + s[k][1]) + (s[k][2] + s[k][3]);
}

/* c[i][j] += sign * row i . row j for i in [first, last), j in [from, to) with j <= i; rows of a lie `stride` apart;
 * first and from are even. */
static void regi_cpd_rows(double *c, size_t c_stride, const double *a, size_t stride, size_t count, double sign,
                          int first, int last, int from, int to)
{
    for (int i = first; i < last; i += 2) {
        int i2 = sbi_min_int(i + 1, last - 1), end = sbi_min_int(to, i2 + 1);
        for (int j = from; j < end; j += 2) {
            int j2 = sbi_min_int(j + 1, end - 1);
            double t[4], *row = c + (size_t)i * c_stride, *row2 = c + (size_t)i2 * c_stride;
            regi_cpd_tile(a + (size_t)i * stride, a + (size_t)i2 * stride, a + (size_t)j * stride,
                          a + (size_t)j2 * stride, count, t);
            row[j] += sign * t[0];
            if (j2 > j && j2 <= i)
                row[j2] += sign * t[1];
            if (i2 > i) {
                row2[j] += sign * t[2];
                if (j2 > j)
                    row2[j2] += sign * t[3];
            }
        }
    }
}

typedef struct regi_cpd_strips {
    regi_cpd_kernel *kernel;
    size_t count; /* rows of the slice */
} regi_cpd_strips;

static void regi_cpd_add_strip(void *user, int index)
{
    const regi_cpd_strips *strips = (const regi_cpd_strips *)user;
    regi_cpd_kernel *kernel = strips->kernel;
    int first = index * REGI_CPD_STRIP, last = sbi_min_int(first + REGI_CPD_STRIP, kernel->rank);
    regi_cpd_rows(kernel->system, kernel->stride, kernel->scaled, REGI_CPD_SLICE, strips->count, 1, first, last, 0,
                  last);
}

/* The lower half of L^T P L + ridge. */
static void regi_cpd_assemble(regi_cpd_kernel *kernel, const double *p, double ridge, const sb_jobs *jobs)
{
    regi_cpd_strips strips;
    double root[REGI_CPD_SLICE];
    int rank = kernel->rank;
    strips.kernel = kernel;
    memset(kernel->system, 0, (size_t)rank * kernel->stride * sizeof(double));
    for (size_t begin = 0; begin < kernel->rows; begin += REGI_CPD_SLICE) {
        strips.count = kernel->rows - begin < REGI_CPD_SLICE ? kernel->rows - begin : (size_t)REGI_CPD_SLICE;
        for (size_t i = 0; i < strips.count; i++)
            root[i] = sqrt(p[begin + i]);
        for (int k = 0; k < rank; k++) {
            const double *column = kernel->columns + (size_t)k * kernel->rows + begin;
            double *scaled = kernel->scaled + (size_t)k * REGI_CPD_SLICE;
            for (size_t i = 0; i < strips.count; i++)
                scaled[i] = root[i] * column[i];
        }
        sbi_run(jobs, regi_cpd_add_strip, &strips, (rank + REGI_CPD_STRIP - 1) / REGI_CPD_STRIP);
    }
    for (int k = 0; k < rank; k++)
        kernel->system[(size_t)k * kernel->stride + (size_t)k] += ridge;
}

/* Row i of the factor between columns from and to; rows up to i are done, and the sums with columns before `from` are
 * subtracted. The ridge keeps every pivot above 0: at least that much is left of it. */
static void regi_cpd_finish_row(double *a, size_t stride, int i, int from, int to, double ridge)
{
    double *row = a + (size_t)i * stride;
    for (int j = from; j < to && j <= i; j++) {
        const double *other = a + (size_t)j * stride;
        double sum = row[j];
        for (int k = from; k < j; k++)
            sum -= row[k] * other[k];
        row[j] = j < i ? sum / other[j] : sqrt(sum > ridge ? sum : ridge);
    }
}

REGI_API void regi_cpd_factor(double *a, int n, size_t stride, double ridge)
{
    for (int from = 0; from < n; from += REGI_CPD_STRIP) {
        int to = sbi_min_int(from + REGI_CPD_STRIP, n);
        for (int first = from; first < n; first += REGI_CPD_STRIP)
            regi_cpd_rows(a, stride, a, stride, (size_t)from, -1, first, sbi_min_int(first + REGI_CPD_STRIP, n), from,
                          to);
        for (int i = from; i < n; i++)
            regi_cpd_finish_row(a, stride, i, from, to, ridge);
    }
}

REGI_API void regi_cpd_back_solve(const double *l, int n, size_t stride, double *b)
{
    for (int i = 0; i < n; i++) {
        const double *row = l + (size_t)i * stride;
        double sum = b[i];
        for (int j = 0; j < i; j++)
            sum -= row[j] * b[j];
        b[i] = sum / row[i];
    }
    for (int i = n - 1; i >= 0; i--) {
        const double *row = l + (size_t)i * stride;
        b[i] /= row[i];
        for (int j = 0; j < i; j++)
            b[j] -= row[j] * b[i];
    }
}

REGI_API double regi_cpd_kernel_solve(regi_cpd_kernel *kernel, const double *p, double *const r[3], double ridge,
                                      const sb_jobs *jobs)
{
    double energy = 0;
    regi_cpd_assemble(kernel, p, ridge, jobs);
    regi_cpd_factor(kernel->system, kernel->rank, kernel->stride, ridge);
    for (int axis = 0; axis < 3; axis++) {
        double *c = kernel->weights[axis];
        for (int k = 0; k < kernel->rank; k++)
            c[k] = regi_cpd_dot(kernel->columns + (size_t)k * kernel->rows, r[axis], kernel->rows);
        regi_cpd_back_solve(kernel->system, kernel->rank, kernel->stride, c);
        energy += regi_cpd_dot(c, c, kernel->stride);
    }
    return energy;
}

REGI_API void regi_cpd_kernel_move(const regi_cpd_kernel *kernel, const regi_cpd_block *points, regi_cpd_block *moved)
{
    int blocks = (int)(kernel->rows / REGI_CPD_LANES);
    memcpy(moved, points, (size_t)blocks * sizeof *moved);
    for (int b = 0; b < blocks; b++)
        for (int k = 0; k < kernel->rank; k++) {
            const double *column = kernel->columns + (size_t)k * kernel->rows + (size_t)b * REGI_CPD_LANES;
            regi_cpd_add(moved[b].x, kernel->weights[0][k], column, REGI_CPD_LANES);
            regi_cpd_add(moved[b].y, kernel->weights[1][k], column, REGI_CPD_LANES);
            regi_cpd_add(moved[b].z, kernel->weights[2][k], column, REGI_CPD_LANES);
        }
}

/* L^-T of the pivots' rows, which are lower triangular: row pivots[k] of column j is 0 for j > k. */
REGI_API void regi_cpd_kernel_spread(regi_cpd_kernel *kernel)
{
    for (int axis = 0; axis < 3; axis++) {
        double *c = kernel->weights[axis];
        for (int k = kernel->rank - 1; k >= 0; k--) {
            const double *column = kernel->columns + (size_t)k * kernel->rows;
            double sum = c[k];
            for (int i = k + 1; i < kernel->rank; i++)
                sum -= column[kernel->pivots[i]] * c[i];
            c[k] = sum / column[kernel->pivots[k]];
        }
    }
}

/* ==== src/register/cpd.c ==== */
/* cpd: coherent point drift; the formulas are those of Myronenko and Song 2010, figures 2 to 4. */

#include <string.h>


enum { REGI_CPD_COOKIE = 0x63706431 };

static const double regi_cpd_least_sigma2 = 1e-10; /* in the frame of the target */

/* z = (x / unit - mean) / size: mean 0, rms 1. */
typedef struct regi_cpd_frame {
    double unit, mean[3], size;
} regi_cpd_frame;

/* y -> linear y + shift, in the frames of the clouds. */
typedef struct regi_cpd_affine {
    double linear[3][3], shift[3];
} regi_cpd_affine;

struct reg_cpd {
    sb_allocator allocator;
    reg_cpd_info info;
    int count;
    regi_cpd_frame source, target;
    regi_cpd_affine map;           /* the identity when non-rigid */
    double inverse;                /* 1 / (2 beta^2) */
    double (*centres)[3];          /* [rank] pivots in the source's frame */
    double (*weights)[3];          /* [rank] */
    sb_vec3 *moved;                /* [count] */
    int *partners;                 /* [count] */
    sb_real *probabilities;        /* [count] */
    void *memory;
};

/* A fit being made. */
typedef struct regi_cpd_run {
    reg_cpd_options options;
    regi_cpd_frame source_frame, target_frame;
    regi_cpd_cloud source, target;
    regi_cpd_block *moved, *next; /* [source blocks] the source after this iteration and after the next */
    double (*landmarks)[3];       /* [landmark_count] their places in the target's frame */
    int *landmark_slots;          /* [landmark_count] in the order of the source */
    double landmark_weight;       /* 1 / sigma^2 of the landmarks, in the target's frame */
    double *p, *r[3];             /* [rows] P and P X - P Y, with landmarks */
    regi_cpd_affine map;
    double sigma2, energy;        /* energy: |L^T W|^2 */
    regi_cpd_kernel kernel;
    regi_cpd_expectation e;
    reg_cpd_info info;
    double start;                 /* s */
    sb_vec3 *sort_points;         /* [larger count] */
    uint32_t *sort_scratch;       /* [3 larger count] */
    int *slot_of;                 /* [source count] */
    void *memory;
} regi_cpd_run;

/* ---- options and input ---- */

REG_API reg_cpd_options reg_default_cpd_options(void)
{
    reg_cpd_options options;
    memset(&options, 0, sizeof options);
    options.kind = REG_CPD_NONRIGID;
    options.outliers = (sb_real)0.1;
    options.beta = 2;
    options.lambda = 3;
    options.kernel_tolerance = (sb_real)1e-4;
    options.max_rank = 1000;
    options.sum_tolerance = (sb_real)1e-5;
    options.tolerance = (sb_real)1e-6;
    options.max_iterations = 300;
    options.max_pairs = 4e8;
    options.cookie = REGI_CPD_COOKIE;
    return options;
}

static sb_result regi_cpd_check_options(const reg_cpd_options *o, sb_error *error)
{
    if (o->cookie != REGI_CPD_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the options were not made by reg_default_cpd_options");
    if ((int)o->kind < REG_CPD_RIGID || (int)o->kind > REG_CPD_NONRIGID)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "kind %d is none of reg_cpd_kind", (int)o->kind);
    if (!(o->outliers >= 0) || !(o->outliers < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the share of outliers is %g, not in [0, 1)", (double)o->outliers);
    if (!(o->beta >= (sb_real)1e-6) || !(o->beta <= (sb_real)1e6))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "beta is %g, not in [1e-6, 1e6]", (double)o->beta);
    if (!(o->lambda >= (sb_real)1e-12) || !(o->lambda <= (sb_real)1e12))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "lambda is %g, not in [1e-12, 1e12]", (double)o->lambda);
    if (!(o->start_sigma >= 0) || !sb_is_finite(o->start_sigma))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "start_sigma is %g", (double)o->start_sigma);
    if (!(o->kernel_tolerance > (sb_real)1e-12) || !(o->kernel_tolerance < 1) || o->max_rank < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "kernel_tolerance %g is not in (1e-12, 1), or max_rank %d below 1",
                        (double)o->kernel_tolerance, o->max_rank);
    if (!(o->sum_tolerance >= 0) || !(o->sum_tolerance <= (sb_real)0.1) || !(o->tolerance >= 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sum_tolerance is %g, not in [0, 0.1], or tolerance %g below 0",
                        (double)o->sum_tolerance, (double)o->tolerance);
    if (o->max_iterations < 0 || !(o->max_seconds >= 0) || !(o->max_pairs >= 0) || (o->max_seconds > 0 && !o->clock))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a cap is below 0, or one of time has no clock");
    return SB_OK;
}

static sb_result regi_cpd_check_cloud(const sb_vec3 *points, int count, const char *name, sb_error *error)
{
    if (!points || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the %s has no points", name);
    for (int i = 0; i < count; i++)
        if (!sb_v3_is_finite(points[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "point %d of the %s is not finite", i, name);
    return SB_OK;
}

static sb_result regi_cpd_check_landmarks(const reg_cpd_options *o, int source_count, sb_error *error)
{
    if (o->landmark_count == 0)
        return SB_OK;
    if (o->landmark_count < 0 || !o->landmark_points || !o->landmark_targets)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d landmarks, or no arrays of them", o->landmark_count);
    if (!(o->landmark_sigma > 0) || !sb_is_finite(o->landmark_sigma))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "landmark_sigma is %g m", (double)o->landmark_sigma);
    for (int i = 0; i < o->landmark_count; i++)
        if (o->landmark_points[i] < 0 || o->landmark_points[i] >= source_count)
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "landmark %d is at point %d of %d", i,
                                 o->landmark_points[i], source_count);
    return regi_cpd_check_cloud(o->landmark_targets, o->landmark_count, "landmarks", error);
}

static sb_result regi_cpd_check(const sb_vec3 *source, int source_count, const sb_vec3 *target, int target_count,
                                const reg_cpd_options *options, sb_error *error)
{
    sb_result result = regi_cpd_check_options(options, error);
    if (result == SB_OK)
        result = regi_cpd_check_cloud(source, source_count, "source", error);
    if (result == SB_OK)
        result = regi_cpd_check_cloud(target, target_count, "target", error);
    if (result == SB_OK)
        result = regi_cpd_check_landmarks(options, source_count, error);
    if (result == SB_OK && (double)source_count * (double)target_count > options->max_pairs)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "%d times %d points are more than max_pairs %g: thin the clouds",
                        source_count, target_count, options->max_pairs);
    return result;
}

/* ---- frames ---- */

static double regi_cpd_largest(double a, double b) { return a > b ? a : b; }

static void regi_cpd_into(const regi_cpd_frame *frame, sb_vec3 point, double z[3])
{
    z[0] = ((double)point.x / frame->unit - frame->mean[0]) / frame->size;
    z[1] = ((double)point.y / frame->unit - frame->mean[1]) / frame->size;
    z[2] = ((double)point.z / frame->unit - frame->mean[2]) / frame->size;
}

static sb_vec3 regi_cpd_out_of(const regi_cpd_frame *frame, const double z[3])
{
    return sb_v3((sb_real)((z[0] * frame->size + frame->mean[0]) * frame->unit),
                 (sb_real)((z[1] * frame->size + frame->mean[1]) * frame->unit),
                 (sb_real)((z[2] * frame->size + frame->mean[2]) * frame->unit));
}

/* Mean in units of frame->unit. */
static void regi_cpd_centre(const sb_vec3 *points, int count, regi_cpd_frame *frame)
{
    for (int k = 0; k < 3; k++)
        frame->mean[k] = 0;
    for (int i = 0; i < count; i++) {
        frame->mean[0] += ((double)points[i].x / frame->unit - frame->mean[0]) / (i + 1);
        frame->mean[1] += ((double)points[i].y / frame->unit - frame->mean[1]) / (i + 1);
        frame->mean[2] += ((double)points[i].z / frame->unit - frame->mean[2]) / (i + 1);
    }
}

/* Size 0 for points in one place. */
static regi_cpd_frame regi_cpd_measure(const sb_vec3 *points, int count)
{
    regi_cpd_frame frame;
    double sum = 0, z[3];
    memset(&frame, 0, sizeof frame);
    for (int i = 0; i < count; i++) {
        frame.unit = regi_cpd_largest(frame.unit, fabs((double)points[i].x));
        frame.unit = regi_cpd_largest(frame.unit, fabs((double)points[i].y));
        frame.unit = regi_cpd_largest(frame.unit, fabs((double)points[i].z));
    }
    if (!(frame.unit > 0))
        frame.unit = 1;
    frame.size = 1;
    regi_cpd_centre(points, count, &frame);
    for (int i = 0; i < count; i++) {
        regi_cpd_into(&frame, points[i], z);
        sum += z[0] * z[0] + z[1] * z[1] + z[2] * z[2];
    }
    frame.size = sqrt(sum / count);
    if (!(frame.size > 1e-14)) /* the rounding of the mean */
        frame.size = 0;
    return frame;
}

/* The frames of both clouds. A cloud in one place has no size of its own and takes the other's. */
static void regi_cpd_set_frames(regi_cpd_run *run, const sb_vec3 *source, int source_count, const sb_vec3 *target,
                                int target_count)
{
    regi_cpd_frame y = regi_cpd_measure(source, source_count), x = regi_cpd_measure(target, target_count);
    if (!(y.size > 0)) {
        y.unit = x.size > 0 ? x.unit : y.unit;
        y.size = x.size > 0 ? x.size : 1.0;
        regi_cpd_centre(source, source_count, &y);
    }
    if (run->options.shared_frame) {
        x = y;
    } else if (run->options.kind == REG_CPD_RIGID || !(x.size > 0)) {
        x.unit = y.unit;
        x.size = y.size;
        regi_cpd_centre(target, target_count, &x);
    }
    run->source_frame = y;
    run->target_frame = x;
}

/* ---- memory ---- */

/* Hands out, or measures, all arrays whose size is known beforehand. */
static void regi_cpd_layout(regi_cpd_run *run, sbi_arena *arena)
{
    size_t m = (size_t)run->source.count, n = (size_t)run->target.count, blocks = (size_t)run->source.blocks;
    size_t more = m > n ? m : n, landmarks = (size_t)run->options.landmark_count, rows = blocks * REGI_CPD_LANES;
    run->source.order = (int *)sbi_arena_take(arena, m, sizeof(int));
    run->source.points = (regi_cpd_block *)sbi_arena_take(arena, blocks, sizeof(regi_cpd_block));
    run->source.boxes = (regi_cpd_box *)sbi_arena_take(arena, blocks, sizeof(regi_cpd_box));
    run->target.order = (int *)sbi_arena_take(arena, n, sizeof(int));
    run->target.points = (regi_cpd_block *)sbi_arena_take(arena, (size_t)run->target.blocks, sizeof(regi_cpd_block));
    run->target.boxes = (regi_cpd_box *)sbi_arena_take(arena, (size_t)run->target.blocks, sizeof(regi_cpd_box));
    run->moved = (regi_cpd_block *)sbi_arena_take(arena, blocks, sizeof(regi_cpd_block));
    run->next = (regi_cpd_block *)sbi_arena_take(arena, blocks, sizeof(regi_cpd_block));
    run->landmarks = (double(*)[3])sbi_arena_take(arena, landmarks, 3 * sizeof(double));
    run->landmark_slots = (int *)sbi_arena_take(arena, landmarks, sizeof(int));
    run->p = (double *)sbi_arena_take(arena, rows, sizeof(double));
    for (int k = 0; k < 3; k++)
        run->r[k] = (double *)sbi_arena_take(arena, rows, sizeof(double));
    run->e.sums = (regi_cpd_sums *)sbi_arena_take(arena, blocks, REGI_CPD_CHUNKS * sizeof(regi_cpd_sums));
    run->e.terms = (double(*)[REGI_CPD_LANES])sbi_arena_take(arena, rows, REGI_CPD_CHUNKS * sizeof(double));
    run->e.near_blocks = (int *)sbi_arena_take(arena, blocks, REGI_CPD_CHUNKS * sizeof(int));
    run->e.best = (regi_cpd_best *)sbi_arena_take(arena, blocks, sizeof(regi_cpd_best));
    run->sort_points = (sb_vec3 *)sbi_arena_take(arena, more, sizeof(sb_vec3));
    run->sort_scratch = (uint32_t *)sbi_arena_take(arena, more, 3 * sizeof(uint32_t));
    run->slot_of = (int *)sbi_arena_take(arena, m, sizeof(int));
}

static sb_result regi_cpd_allocate(regi_cpd_run *run, sb_error *error)
{
    sbi_arena arena;
    memset(&arena, 0, sizeof arena);
    regi_cpd_layout(run, &arena);
    run->memory = arena.overflow ? NULL : sbi_alloc(&run->options.allocator, arena.used, 1);
    if (!run->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for clouds of %d and %d points", run->source.count,
                        run->target.count);
    arena.base = (unsigned char *)run->memory;
    arena.used = 0;
    regi_cpd_layout(run, &arena);
    return SB_OK;
}

/* ---- start ---- */

/* Sorts the points and puts them into blocks, in their frame. */
static sb_result regi_cpd_fill(regi_cpd_run *run, regi_cpd_cloud *cloud, const sb_vec3 *points,
                               const regi_cpd_frame *frame, sb_error *error)
{
    double z[3], most = 0;
    for (int i = 0; i < cloud->count; i++) {
        regi_cpd_into(frame, points[i], z);
        run->sort_points[i] = sb_v3((sb_real)z[0], (sb_real)z[1], (sb_real)z[2]);
        for (int k = 0; k < 3; k++)
            most = z[k] - z[k] == 0.0 ? regi_cpd_largest(most, fabs(z[k])) : 1.7976931348623157e308;
        if (!(most < 1e15)) /* source and target far apart: squares must keep the digits of the smaller */
            return sbi_fail(error, SB_ERROR_ARGUMENT, "the clouds are too far apart or too unlike in size");
    }
    sbi_embed_sort(run->sort_points, cloud->count, cloud->order, run->sort_scratch);
    for (int i = 0; i < cloud->blocks * REGI_CPD_LANES; i++) {
        regi_cpd_block *block = cloud->points + i / REGI_CPD_LANES;
        regi_cpd_into(frame, points[cloud->order[sbi_min_int(i, cloud->count - 1)]], z);
        block->x[i % REGI_CPD_LANES] = z[0];
        block->y[i % REGI_CPD_LANES] = z[1];
        block->z[i % REGI_CPD_LANES] = z[2];
    }
    regi_cpd_bound(cloud->points, cloud->blocks, cloud->boxes);
    return SB_OK;
}

static sb_result regi_cpd_fill_landmarks(regi_cpd_run *run, sb_error *error)
{
    const reg_cpd_options *o = &run->options;
    double sigma = (double)o->landmark_sigma / run->target_frame.unit / run->target_frame.size;
    for (int i = 0; i < run->source.count; i++)
        run->slot_of[run->source.order[i]] = i;
    for (int i = 0; i < o->landmark_count; i++) {
        double *z = run->landmarks[i];
        run->landmark_slots[i] = run->slot_of[o->landmark_points[i]];
        regi_cpd_into(&run->target_frame, o->landmark_targets[i], z);
        if (!(fabs(z[0]) < 1e15) || !(fabs(z[1]) < 1e15) || !(fabs(z[2]) < 1e15))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "landmark %d is too far from the target", i);
    }
    if (o->landmark_count > 0) {
        if (!(sigma > 1e-9)) /* a weight that the system can take */
            return sbi_fail(error, SB_ERROR_ARGUMENT, "landmark_sigma %g m is below 1e-9 of the target's size",
                            (double)o->landmark_sigma);
        run->landmark_weight = 1 / (sigma * sigma);
    }
    return SB_OK;
}

/* Mean squared distance, per axis, of all pairs of points. */
static double regi_cpd_spread(const regi_cpd_cloud *a, const regi_cpd_cloud *b)
{
    const regi_cpd_cloud *cloud[2];
    double mean[2][3], squares = 0, gap = 0;
    cloud[0] = a, cloud[1] = b;
    for (int c = 0; c < 2; c++) {
        double sum = 0;
        mean[c][0] = mean[c][1] = mean[c][2] = 0;
        for (int i = 0; i < cloud[c]->count; i++) {
            const regi_cpd_block *p = cloud[c]->points + i / REGI_CPD_LANES;
            int l = i % REGI_CPD_LANES;
            mean[c][0] += p->x[l] / cloud[c]->count;
            mean[c][1] += p->y[l] / cloud[c]->count;
            mean[c][2] += p->z[l] / cloud[c]->count;
            sum += p->x[l] * p->x[l] + p->y[l] * p->y[l] + p->z[l] * p->z[l];
        }
        squares += sum / cloud[c]->count;
    }
    for (int k = 0; k < 3; k++)
        gap += mean[0][k] * mean[1][k];
    return (squares - 2 * gap) / 3;
}

static sb_result regi_cpd_prepare(regi_cpd_run *run, const sb_vec3 *source, const sb_vec3 *target, sb_error *error)
{
    const reg_cpd_options *o = &run->options;
    double sigma = (double)o->start_sigma / run->target_frame.unit / run->target_frame.size;
    sb_result result = regi_cpd_allocate(run, error);
    if (result == SB_OK)
        result = regi_cpd_fill(run, &run->source, source, &run->source_frame, error);
    if (result == SB_OK)
        result = regi_cpd_fill(run, &run->target, target, &run->target_frame, error);
    if (result == SB_OK)
        result = regi_cpd_fill_landmarks(run, error);
    if (result == SB_OK && o->kind == REG_CPD_NONRIGID) {
        double begun = o->clock ? o->clock() : 0.0;
        result = regi_cpd_kernel_create(&run->source, (double)o->beta, (double)o->kernel_tolerance, o->max_rank,
                                        &o->allocator, &run->kernel, error);
        run->info.rank = run->kernel.rank;
        run->info.kernel_seconds = o->clock ? o->clock() - begun : 0.0;
    }
    if (result != SB_OK)
        return result;
    for (int k = 0; k < 3; k++)
        run->map.linear[k][k] = 1;
    memcpy(run->moved, run->source.points, (size_t)run->source.blocks * sizeof *run->moved);
    run->sigma2 = sigma > 0 ? sigma * sigma : regi_cpd_spread(&run->source, &run->target);
    if (!(run->sigma2 > regi_cpd_least_sigma2))
        run->sigma2 = regi_cpd_least_sigma2;
    return SB_OK;
}

/* ---- expectation ---- */

/* 1 / sigma^2 sum |T y - x|^2 of the landmarks. */
static double regi_cpd_landmark_energy(const regi_cpd_run *run)
{
    double sum = 0;
    for (int i = 0; i < run->options.landmark_count; i++) {
        int slot = run->landmark_slots[i], lane = slot % REGI_CPD_LANES;
        const regi_cpd_block *block = run->moved + slot / REGI_CPD_LANES;
        const double *z = run->landmarks[i];
        double x = block->x[lane] - z[0], y = block->y[lane] - z[1], w = block->z[lane] - z[2];
        sum += x * x + y * y + w * w;
    }
    return run->landmark_weight * sum;
}

static sb_result regi_cpd_look(regi_cpd_run *run, int with_partners, sb_error *error)
{
    const reg_cpd_options *o = &run->options;
    regi_cpd_expectation e = run->e;
    double m = run->source.count, n = run->target.count, w = (double)o->outliers, area;
    double turn = 6.283185307179586 * run->sigma2;
    area = turn * sqrt(turn); /* the reciprocal of a Gaussian's peak */
    e.source = &run->source;
    e.target = &run->target;
    e.moved = run->moved;
    e.sigma2 = run->sigma2;
    e.outlier = area * w / (1 - w) * m / n;
    e.tolerance = (double)o->sum_tolerance;
    e.best = with_partners ? run->e.best : NULL;
    regi_cpd_bound(run->moved, run->source.blocks, run->source.boxes);
    regi_cpd_expect(&e, &o->jobs);
    memcpy(run->e.totals, e.totals, sizeof e.totals);
    if (!(e.totals[0].explained > 1e-12 * n))
        return sbi_fail(error, SB_ERROR_NOT_CONVERGED, "no target point is near enough the source: all are outliers");
    run->info.pairs += e.totals[0].pairs;
    run->info.explained = (sb_real)e.totals[0].explained;
    run->info.sigma = (sb_real)(sqrt(run->sigma2) * run->target_frame.size * run->target_frame.unit);
    run->info.objective = e.totals[0].logs + n * sbi_dense_log(m * area / (1 - w)) +
                          0.5 * ((double)o->lambda * run->energy + regi_cpd_landmark_energy(run));
    return SB_OK;
}

/* ---- maximisation ---- */

/* p and r = sum P x - p T, with the landmarks as further partners of that weight. */
static void regi_cpd_collect(regi_cpd_run *run)
{
    double weight = run->sigma2 * run->landmark_weight;
    for (int b = 0; b < run->source.blocks; b++) {
        size_t first = (size_t)b * REGI_CPD_LANES, bytes = sizeof run->e.sums[b].p;
        memcpy(run->p + first, run->e.sums[b].p, bytes);
        memcpy(run->r[0] + first, run->e.sums[b].x, bytes);
        memcpy(run->r[1] + first, run->e.sums[b].y, bytes);
        memcpy(run->r[2] + first, run->e.sums[b].z, bytes);
    }
    for (int i = 0; i < run->options.landmark_count; i++) {
        int slot = run->landmark_slots[i], lane = slot % REGI_CPD_LANES;
        const regi_cpd_block *block = run->moved + slot / REGI_CPD_LANES;
        run->p[slot] += weight;
        run->r[0][slot] += weight * (run->landmarks[i][0] - block->x[lane]);
        run->r[1][slot] += weight * (run->landmarks[i][1] - block->y[lane]);
        run->r[2][slot] += weight * (run->landmarks[i][2] - block->z[lane]);
    }
}

/* Moments of the expected pairs: `cross` of the target's with the source's points, `spread` of the source's. */
typedef struct regi_cpd_moments {
    double x[3], y[3]; /* weighted means */
    double cross[3][3], spread[3][3];
} regi_cpd_moments;

static void regi_cpd_weigh(const regi_cpd_run *run, regi_cpd_moments *s)
{
    double total = 0;
    memset(s, 0, sizeof *s);
    for (int pass = 0; pass < 2; pass++) {
        for (int i = 0; i < run->source.count; i++) {
            int b = i / REGI_CPD_LANES, l = i % REGI_CPD_LANES;
            const regi_cpd_block *from = run->source.points + b, *at = run->moved + b;
            double p = run->p[i], y[3], x[3]; /* x: p times the mean place of the partners */
            y[0] = from->x[l], y[1] = from->y[l], y[2] = from->z[l];
            x[0] = run->r[0][i] + p * at->x[l], x[1] = run->r[1][i] + p * at->y[l];
            x[2] = run->r[2][i] + p * at->z[l];
            total += pass == 0 ? p : 0.0;
            for (int j = 0; j < 3; j++) {
                s->x[j] += pass == 0 ? x[j] : 0.0;
                s->y[j] += pass == 0 ? p * y[j] : 0.0;
                for (int k = 0; k < 3 && pass == 1; k++) {
                    s->cross[j][k] += (x[j] - p * s->x[j]) * (y[k] - s->y[k]);
                    s->spread[j][k] += p * (y[j] - s->y[j]) * (y[k] - s->y[k]);
                }
            }
        }
        for (int j = 0; j < 3 && pass == 0; j++) {
            s->x[j] /= total;
            s->y[j] /= total;
        }
    }
}

/* The rotation nearest to the cross moments, times the scale. Where they say nothing the last one stays. */
static void regi_cpd_turn(regi_cpd_run *run, const regi_cpd_moments *s)
{
    double most = 0, trace = 0, spread = s->spread[0][0] + s->spread[1][1] + s->spread[2][2], scale = 1;
    sb_mat3 a, u, v, rotation;
    sb_vec3 stretches;
    for (int j = 0; j < 9; j++)
        most = regi_cpd_largest(most, fabs(s->cross[j / 3][j % 3]));
    if (!(most > 0))
        return;
    for (int j = 0; j < 9; j++)
        a.m[j / 3][j % 3] = (sb_real)(s->cross[j / 3][j % 3] / most);
    sb_m3_svd(a, &u, &stretches, &v);
    rotation = sb_m3_mult(u, v);
    for (int j = 0; j < 9; j++)
        trace += s->cross[j / 3][j % 3] * (double)rotation.m[j / 3][j % 3];
    if (run->options.kind == REG_CPD_SIMILARITY && trace > 0 && spread > 0)
        scale = trace / spread;
    for (int j = 0; j < 9; j++)
        run->map.linear[j / 3][j % 3] = scale * (double)rotation.m[j / 3][j % 3];
}

/* B += (A - B C) C^-1 of the moments A and C. C is made regular by a little: directions in which the source has no
 * extent keep the B they had, all others get theirs to 1e-10 in the first iteration, and further digits in the next. */
static void regi_cpd_stretch(regi_cpd_run *run, const regi_cpd_moments *s)
{
    double ridge = 1e-10 * (s->spread[0][0] + s->spread[1][1] + s->spread[2][2]), c[3][4], row[3];
    if (!(ridge > 0))
        return;
    for (int j = 0; j < 3; j++)
        for (int k = 0; k < 3; k++)
            c[j][k] = s->spread[j][k] + (j == k ? ridge : 0.0);
    regi_cpd_factor(c[0], 3, 4, ridge);
    for (int j = 0; j < 3; j++) {
        for (int k = 0; k < 3; k++) {
            row[k] = s->cross[j][k];
            for (int i = 0; i < 3; i++)
                row[k] -= run->map.linear[j][i] * s->spread[i][k];
        }
        regi_cpd_back_solve(c[0], 3, 4, row);
        for (int k = 0; k < 3; k++)
            run->map.linear[j][k] += row[k];
    }
}

static void regi_cpd_map(const regi_cpd_affine *map, const double y[3], double out[3])
{
    for (int j = 0; j < 3; j++)
        out[j] = map->linear[j][0] * y[0] + map->linear[j][1] * y[1] + map->linear[j][2] * y[2] + map->shift[j];
}

static void regi_cpd_move_linear(regi_cpd_run *run)
{
    regi_cpd_moments s;
    regi_cpd_weigh(run, &s);
    if (run->options.kind == REG_CPD_AFFINE)
        regi_cpd_stretch(run, &s);
    else
        regi_cpd_turn(run, &s);
    for (int j = 0; j < 3; j++) {
        run->map.shift[j] = s.x[j];
        for (int k = 0; k < 3; k++)
            run->map.shift[j] -= run->map.linear[j][k] * s.y[k];
    }
    for (int b = 0; b < run->source.blocks; b++)
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            const regi_cpd_block *from = run->source.points + b;
            double y[3], x[3];
            y[0] = from->x[l], y[1] = from->y[l], y[2] = from->z[l];
            regi_cpd_map(&run->map, y, x);
            run->next[b].x[l] = x[0], run->next[b].y[l] = x[1], run->next[b].z[l] = x[2];
        }
}

static void regi_cpd_move_freely(regi_cpd_run *run)
{
    for (int b = 0; b < run->source.blocks; b++)
        for (int l = 0; l < REGI_CPD_LANES; l++) { /* from distances to T to distances to Y */
            const regi_cpd_block *from = run->source.points + b, *at = run->moved + b;
            size_t i = (size_t)b * REGI_CPD_LANES + (size_t)l;
            run->r[0][i] += run->p[i] * (at->x[l] - from->x[l]);
            run->r[1][i] += run->p[i] * (at->y[l] - from->y[l]);
            run->r[2][i] += run->p[i] * (at->z[l] - from->z[l]);
        }
    run->energy = regi_cpd_kernel_solve(&run->kernel, run->p, run->r, (double)run->options.lambda * run->sigma2,
                                        &run->options.jobs);
    regi_cpd_kernel_move(&run->kernel, run->source.points, run->next);
}

/* sigma^2 = sum P |x - T'|^2 / (3 sum P), by the way d from T to the new T': sum P |x - T|^2 - 2 d.r + P |d|^2. */
static void regi_cpd_narrow(regi_cpd_run *run)
{
    double sum = run->e.totals[0].squares;
    for (int b = 0; b < run->source.blocks; b++)
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            const regi_cpd_sums *s = run->e.sums + b;
            double x = run->next[b].x[l] - run->moved[b].x[l], y = run->next[b].y[l] - run->moved[b].y[l];
            double z = run->next[b].z[l] - run->moved[b].z[l];
            sum += s->p[l] * (x * x + y * y + z * z) - 2 * (s->x[l] * x + s->y[l] * y + s->z[l] * z);
        }
    run->sigma2 = sum / (3 * run->e.totals[0].explained);
    if (!(run->sigma2 > regi_cpd_least_sigma2))
        run->sigma2 = regi_cpd_least_sigma2;
}

/* ---- iteration ---- */

static void regi_cpd_step(regi_cpd_run *run)
{
    regi_cpd_block *swap = run->moved;
    regi_cpd_collect(run);
    if (run->options.kind == REG_CPD_NONRIGID)
        regi_cpd_move_freely(run);
    else
        regi_cpd_move_linear(run);
    regi_cpd_narrow(run);
    run->moved = run->next;
    run->next = swap;
    run->info.iterations++;
}

/* 1 when the last iteration was the last one; why is in info.stop. */
static int regi_cpd_is_done(regi_cpd_run *run)
{
    const reg_cpd_options *o = &run->options;
    if (!(run->sigma2 > regi_cpd_least_sigma2))
        run->info.stop = REG_CPD_EXACT;
    else if (run->info.iterations > 0 && run->info.change <= o->tolerance)
        run->info.stop = REG_CPD_CONVERGED;
    else if (run->info.iterations >= o->max_iterations)
        run->info.stop = REG_CPD_ITERATIONS;
    else if (o->max_seconds > 0 && run->info.seconds >= o->max_seconds)
        run->info.stop = REG_CPD_TIME;
    else
        return 0;
    return run->info.iterations > 0 || o->max_iterations == 0;
}

static sb_result regi_cpd_iterate(regi_cpd_run *run, sb_error *error)
{
    const reg_cpd_options *o = &run->options;
    sb_result result = regi_cpd_look(run, 0, error);
    while (result == SB_OK && !regi_cpd_is_done(run)) {
        double before = run->info.objective;
        regi_cpd_step(run);
        result = regi_cpd_look(run, 0, error);
        run->info.change = (sb_real)((before - run->info.objective) / run->target.count);
        run->info.seconds = o->clock ? o->clock() - run->start : 0.0;
        if (result == SB_OK && o->progress && o->progress(o->progress_user, &run->info) != 0)
            return sbi_fail(error, SB_ERROR_CANCELLED, "stopped by the progress callback after %d iterations",
                            run->info.iterations);
    }
    return result == SB_OK ? regi_cpd_look(run, 1, error) : result;
}

/* ---- result ---- */

static void regi_cpd_fit_layout(reg_cpd *fit, sbi_arena *arena)
{
    size_t count = (size_t)fit->count, rank = (size_t)fit->info.rank;
    fit->centres = (double(*)[3])sbi_arena_take(arena, rank, 3 * sizeof(double));
    fit->weights = (double(*)[3])sbi_arena_take(arena, rank, 3 * sizeof(double));
    fit->moved = (sb_vec3 *)sbi_arena_take(arena, count, sizeof(sb_vec3));
    fit->partners = (int *)sbi_arena_take(arena, count, sizeof(int));
    fit->probabilities = (sb_real *)sbi_arena_take(arena, count, sizeof(sb_real));
}

static reg_cpd *regi_cpd_fit_allocate(const regi_cpd_run *run)
{
    const sb_allocator *allocator = &run->options.allocator;
    reg_cpd *fit = (reg_cpd *)sbi_alloc_zeroed(allocator, 1, sizeof(reg_cpd));
    sbi_arena arena;
    if (!fit)
        return NULL;
    memset(&arena, 0, sizeof arena);
    fit->allocator = *allocator;
    fit->info = run->info;
    fit->count = run->source.count;
    regi_cpd_fit_layout(fit, &arena);
    fit->memory = arena.overflow ? NULL : sbi_alloc(allocator, arena.used, 1);
    if (!fit->memory) {
        sbi_free(allocator, fit);
        return NULL;
    }
    arena.base = (unsigned char *)fit->memory;
    arena.used = 0;
    regi_cpd_fit_layout(fit, &arena);
    return fit;
}

static sb_result regi_cpd_finish(regi_cpd_run *run, reg_cpd **out, sb_error *error)
{
    reg_cpd *fit = regi_cpd_fit_allocate(run);
    if (!fit)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the fit of %d points", run->source.count);
    fit->source = run->source_frame;
    fit->target = run->target_frame;
    fit->map = run->map;
    fit->inverse = run->kernel.inverse;
    for (int i = 0; i < fit->count; i++) {
        int b = i / REGI_CPD_LANES, l = i % REGI_CPD_LANES, index = run->source.order[i];
        double z[3];
        z[0] = run->moved[b].x[l], z[1] = run->moved[b].y[l], z[2] = run->moved[b].z[l];
        fit->moved[index] = regi_cpd_out_of(&fit->target, z);
        fit->partners[index] = run->e.best[b].target[l];
        fit->probabilities[index] = (sb_real)run->e.best[b].probability[l];
    }
    if (fit->info.rank > 0)
        regi_cpd_kernel_spread(&run->kernel);
    for (int k = 0; k < fit->info.rank; k++) {
        int b = run->kernel.pivots[k] / REGI_CPD_LANES, l = run->kernel.pivots[k] % REGI_CPD_LANES;
        fit->centres[k][0] = run->source.points[b].x[l];
        fit->centres[k][1] = run->source.points[b].y[l];
        fit->centres[k][2] = run->source.points[b].z[l];
        for (int axis = 0; axis < 3; axis++)
            fit->weights[k][axis] = run->kernel.weights[axis][k];
    }
    *out = fit;
    return SB_OK;
}

REG_API sb_result reg_cpd_fit(const sb_vec3 *source, int source_count, const sb_vec3 *target, int target_count,
                              const reg_cpd_options *options, reg_cpd **fit, sb_error *error)
{
    regi_cpd_run run;
    sb_result result;
    memset(&run, 0, sizeof run);
    run.options = options ? *options : reg_default_cpd_options();
    if (!fit)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "no place for the fit");
    result = regi_cpd_check(source, source_count, target, target_count, &run.options, error);
    if (result != SB_OK)
        return result;
    run.start = run.options.clock ? run.options.clock() : 0.0;
    run.source.count = source_count;
    run.source.blocks = (source_count - 1) / REGI_CPD_LANES + 1;
    run.target.count = target_count;
    run.target.blocks = (target_count - 1) / REGI_CPD_LANES + 1;
    run.kernel.allocator = run.options.allocator;
    regi_cpd_set_frames(&run, source, source_count, target, target_count);
    result = regi_cpd_prepare(&run, source, target, error);
    if (result == SB_OK)
        result = regi_cpd_iterate(&run, error);
    if (result == SB_OK)
        result = regi_cpd_finish(&run, fit, error);
    regi_cpd_kernel_free(&run.kernel);
    sbi_free(&run.options.allocator, run.memory);
    return result;
}

REG_API void reg_cpd_destroy(reg_cpd *fit)
{
    sb_allocator allocator;
    if (!fit)
        return;
    allocator = fit->allocator;
    sbi_free(&allocator, fit->memory);
    sbi_free(&allocator, fit);
}

REG_API reg_cpd_info reg_cpd_get_info(const reg_cpd *fit) { return fit->info; }
REG_API const sb_vec3 *reg_cpd_moved(const reg_cpd *fit) { return fit->moved; }
REG_API const int *reg_cpd_partners(const reg_cpd *fit) { return fit->partners; }
REG_API const sb_real *reg_cpd_probabilities(const reg_cpd *fit) { return fit->probabilities; }

REG_API void reg_cpd_linear(const reg_cpd *fit, sb_mat3 *linear, sb_vec3 *translation)
{
    const regi_cpd_frame *from = &fit->source, *to = &fit->target;
    double ratio = to->unit / from->unit * (to->size / from->size), at[3];
    for (int j = 0; j < 3; j++) {
        at[j] = to->mean[j] + to->size * fit->map.shift[j]; /* in units of the target */
        for (int k = 0; k < 3; k++) {
            linear->m[j][k] = (sb_real)(ratio * fit->map.linear[j][k]);
            at[j] -= to->size / from->size * fit->map.linear[j][k] * from->mean[k];
        }
    }
    *translation = sb_v3((sb_real)(to->unit * at[0]), (sb_real)(to->unit * at[1]), (sb_real)(to->unit * at[2]));
}

REG_API void reg_cpd_apply(const reg_cpd *fit, const sb_vec3 *points, int count, sb_vec3 *moved)
{
    if (!fit || !points || !moved)
        return;
    for (int i = 0; i < count; i++) {
        double y[3], out[3];
        regi_cpd_into(&fit->source, points[i], y);
        regi_cpd_map(&fit->map, y, out);
        for (int k = 0; k < fit->info.rank; k++) {
            const double *centre = fit->centres[k], *weight = fit->weights[k];
            double dx = y[0] - centre[0], dy = y[1] - centre[1], dz = y[2] - centre[2];
            double g = sbi_dense_exp(-(dx * dx + dy * dy + dz * dz) * fit->inverse);
            for (int axis = 0; axis < 3; axis++)
                out[axis] += g * weight[axis];
        }
        moved[i] = regi_cpd_out_of(&fit->target, out);
    }
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
