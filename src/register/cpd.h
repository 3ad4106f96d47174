/* cpd: coherent point drift, which moves one point cloud onto another without knowing pairs. Floor 6.
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

#include "api.h"

typedef enum reg_cpd_kind {
    REG_CPD_RIGID = 0,      /* rotation, translation */
    REG_CPD_SIMILARITY = 1, /* rotation, translation, scale */
    REG_CPD_AFFINE = 2,
    REG_CPD_NONRIGID = 3 /* y + sum_k exp(-|y - c_k|^2 / 2 beta^2) w_k */
} reg_cpd_kind;

typedef enum reg_cpd_stop {
    REG_CPD_CONVERGED = 0,  /* the objective fell by no more than the tolerance */
    REG_CPD_EXACT = 1,      /* the clouds lie on each other: sigma fell to 1e-5 of the target's size */
    REG_CPD_ITERATIONS = 2, /* cap */
    REG_CPD_TIME = 3        /* cap */
} reg_cpd_stop;

/* How far a fit is, and how it ended. */
typedef struct reg_cpd_info {
    int iterations; /* updates of the motion */
    int rank;       /* columns of the kernel's factor; 0 unless non-rigid */
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
    sb_clock clock;         /* default NULL */
    sb_allocator allocator; /* default malloc */
    sb_jobs jobs;           /* default inline; any gives the same bits */
    unsigned cookie;        /* set by reg_default_cpd_options; options made without it are refused */
} reg_cpd_options;

REG_API reg_cpd_options reg_default_cpd_options(void);

/* What was fitted. */
typedef struct reg_cpd reg_cpd;

/* Moves source onto target.
 * source, target  [count] (m), at least one point each, in any order; copied
 * options         NULL: defaults
 * fit             made on success; the caller's, for reg_cpd_destroy; untouched otherwise
 * A cap that was reached is no error: info.stop reports it, and the fit is as good as it got.
 * Cost of an iteration: at most source_count target_count exponentials (about 5 ns each), and as sigma shrinks those of
 * near blocks of points only; non-rigid in addition source_count rank^2 / 2 + rank^3 / 6 multiply-adds. Memory: rank
 * (source_count + rank) doubles. The same bits for any jobs.
 * SB_ERROR_ARGUMENT (also a landmark of no point: error->node is its index), _NOT_FINITE (error->node; the message
 * names the cloud; also where a fit goes beyond what sb_real holds), _UNSUPPORTED (more than max_pairs), _CANCELLED,
 * _NOT_CONVERGED (no target point is near enough any source point to be more than an outlier), _MEMORY. */
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
