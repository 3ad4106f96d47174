/* step: time steps and static solves of a body. Floor 3. */
#ifndef SB_STEP_H
#define SB_STEP_H

#include "body.h"

/* Why a static solve ended. */
typedef enum sb_stop_reason {
    SB_STOP_NONE = 0,      /* it failed, or this was a time step */
    SB_STOP_CONVERGED = 1, /* the measures below met the tolerance */
    SB_STOP_FLOOR = 2 /* rounding keeps the forces from balancing any better: `energy` says what it may be off by */
} sb_stop_reason;

/* How a static solve iterates. */
typedef enum sb_newton {
    SB_NEWTON_AUTO = 0,  /* mixed points for thin nonlinear bodies (sb_body_slenderness over 30), otherwise plain */
    SB_NEWTON_PLAIN = 1, /* Newton with a line search */
    SB_NEWTON_MIXED_POINTS =
        2 /* the tangent takes the stress of each point extrapolated along the last increment in place
           * of the stress there (Magisano, Leonetti and Garcea 2017): the false membrane stress of
           * thin bodies that turn no longer stiffens it, and iterations hardly depend on their
           * thinness. Same answers. Whole increments, since no energy has to fall on the way; where
           * they do not converge the load increment is halved, three times, and is plain then. Not
           * with tools, linear materials, quasi_newton or a single rotation: plain there */
} sb_newton;

/* Where the first increment of a static solve starts. */
typedef enum sb_start {
    SB_START_AUTO = 0,     /* SB_START_ROTATIONS from the undeformed shape, otherwise the present shape */
    SB_START_PRESENT = 1,  /* the present shape */
    SB_START_ROTATIONS = 2 /* the linear solution about the present shape, then the equilibrium of a corotated material
                            * with the same moduli in one system with the rotations of that solution held. Looked for
                            * only where the linear solution is far from balance, and taken only where its potential is
                            * below that of the linear solution and, unless supports move, of the present shape. Not
                            * with tools, linear materials or a single rotation. Takes memory for the time of the call,
                            * and starts from the present shape without. Same answers in fewer iterations where
                            * elements turn by much (10 -> 6); one more where it is looked for and not taken */
} sb_start;

/* How good the answer of a static solve is, of its last increment. What supports at rest hold hardly counts in it: of
 * thin bodies that is many times the load. */
typedef struct sb_static_report {
    sb_stop_reason reason;
    int iterations;    /* of Newton */
    sb_real force;     /* |out-of-balance force| / the loads: the largest of the present ones, those of the static solve
                        * before, those that follow, contact's, the work of supports that move over the way that they
                        * go, and the reactions of supports as far as they are no more than ten times these; where there
                        * are none of these, all of the reactions */
    sb_real energy;    /* twice r.K^-1 r / work of the loads since the solve began, that of supports that move included:
                        * the square of the error relative to the displacement, both in the energy norm; the error of
                        * the mean displacement under the load relative to it is at most the root. An estimate: K is that
                        * of the last system, and by conjugate gradients r.M^-1 r / the smallest eigenvalue of M^-1 K
                        * that its solve has seen stands for it. Of several connected parts that where it is largest.
                        * -1: not known, as with tools in touch or where nothing had to be solved */
    sb_real increment; /* largest displacement that the present factor or preconditioner would yet add / the largest
                        * since the solve began; -1 as above */
    sb_real floor;     /* rounding errors in the out-of-balance force, relative as `force` */
    sb_newton newton;  /* what it went by in the end; never SB_NEWTON_AUTO */
    sb_precond_kind solver; /* of its last system */
} sb_static_report;

/* What a step or a static solve did. Every field is written by every call, failed ones too. */
typedef struct sb_step_info {
    int newton_iterations;    /* linear systems solved; an iteration whose exact tangent fails solves two */
    int pcg_iterations;       /* of all of them together */
    int substeps;             /* SB_CENTRAL_DIFFERENCE: explicit steps taken; parts of a step that contact made divide
                               * itself (contact.h); otherwise 0 */
    int load_steps;           /* static: load increments that converged; a time step: 1 */
    sb_real load_factor;      /* static: share of load and prescribed motion carried, 1 when done */
    sb_real residual;         /* out-of-balance force relative to the largest force (in a static solve: as
                               * sb_static_report.force), at the last check; a linearised
                               * step (max_newton 1): |b - A x| / |b| of its linear solve. Of several connected parts
                               * that where it is largest */
    int capped;               /* 1: an iteration cap was hit and the best state so far was taken */
    double seconds_force;     /* with a clock, otherwise 0: rotations and internal forces, */
    double seconds_tangent;   /* assembly, */
    double seconds_precond;   /* preconditioner set-up, */
    double seconds_solve;     /* conjugate gradients, */
    double seconds_total;     /* and the whole call */
    sb_error error;           /* result, message, element or node when the call failed */
    sb_static_report statics; /* of a static solve; 0 of a time step */
} sb_step_info;

/* Advances the body by dt (s, > 0) with its integrator. Supports reach their targets exactly.
 *
 * With max_newton 1 the step is linearised (one system, Baraff and Witkin 1998): its cost is bounded and the
 * result is taken even when max_iterations cut the linear solve short (info->capped). With hyperelastic materials,
 * whose forces grow faster than displacements, it is shortened until no energy comes from nowhere. With more
 * iterations each is followed by a line search on the step's potential, which also refuses inverted elements for
 * materials that have no energy there.
 *
 * SB_CENTRAL_DIFFERENCE takes dt in equal substeps of at most 0.9 stable steps, as many as that needs; the stable step
 * is found anew every 16 substeps as the body deforms; springs, mappings and constraints count in it, so that stiff
 * ones make substeps short, and so does a tool that is near (contact.h). Substeps that go bad all the same (an element
 * inverted, more energy than came in) are taken back, and the call is done again with shorter ones, up to three times.
 *
 * Prony terms move on with the step: exact where the relaxing stress changes evenly within it, of second order
 * otherwise. Where a material that may turn inside out is nearly flat (det F < 0.05) they remember less, and inside out
 * nothing, lest the memory hold it there.
 *
 * info may be NULL. On failure (SB_ERROR_ARGUMENT, SB_ERROR_INVERTED naming the element, SB_ERROR_DIVERGED,
 * SB_ERROR_INDEFINITE; SB_ERROR_NOT_CONVERGED naming the stable step: more than max_substeps; SB_ERROR_UNSUPPORTED
 * where Newmark meets SB_MASS_REDUCED, or central difference, and constraints that cannot be lumped) positions,
 * velocities, accelerations, reactions and constraint forces are as before the call and the body can go on, to the last
 * bit as if the call had not been; so is what Prony terms remember. Allocates nothing. Formulas: implicit Euler and
 * Newmark in the increment du,
 *     (ca M + cv D + K) du = f_ext - f_int - M a0 - D v0,  D = alpha M + beta K;
 * generalised alpha the same with u at the time of its balance, from which the end of the step is extrapolated;
 * supports and gaps of constraints are that share of their way along by then, pressures and the points of springs at
 * their present values throughout. Where the material does not admit that end, the step is done again with spectral
 * radius 0, whose balance is at the end. K in D is that of the start of the step, so that with beta > 0 iterated
 * steps of nonlinear bodies (Newmark, generalised alpha) are of first order in time.
 * Central difference:
 *     u' = u + h v + h^2/2 a,  (M + h/2 D) a' = f_ext(u') - f_int(u') - D (v + h/2 a),  v' = v + h/2 (a + a'),
 * and of slaves u', v', a' follow from their masters, which carry the slaves' mass lumped (row sums of T^T M T). */
SB_API sb_result sb_body_step(sb_body *body, sb_real dt, sb_step_info *info);

/* *dt (s) = the longest step that is sure to be stable under SB_CENTRAL_DIFFERENCE at the present shape with the
 * lumped mass, 2/omega_max from a bound of omega_max that is never below it: typically 0.8 to 0.99 of the true limit.
 * Springs, mappings, pressures and constraints count, Prony terms with their instantaneous stiffness. Mass damping does
 * not change it; supports of unconstrained bodies are left out of account. Works for bodies of any integrator and
 * leaves their state as it is. Costs an assembly of the tangent and some products with it; allocates nothing. On
 * failure (SB_ERROR_ARGUMENT, SB_ERROR_INVERTED naming the element, SB_ERROR_NOT_FINITE, SB_ERROR_UNSUPPORTED for
 * constraints that cannot be lumped) *dt is untouched; error may be NULL.
 * Bound: max over rows of (|K| x)_i / (m_i x_i) for a positive x (Collatz 1942, Wielandt 1950), x by iteration. */
SB_API sb_result sb_body_stable_step(sb_body *body, sb_real *dt, sb_error *error);

/* How a static solve goes about its work. Start from sb_default_static_options(). */
typedef struct sb_static_options {
    int load_steps;     /* equal increments to begin with, >= 1; they grow and shrink as Newton converges;
                         * default 1 */
    sb_real tolerance;  /* of sb_static_report.force, (0, 1), in each connected part; its `energy` must be no more than
                         * a hundredth of it, so that 1e-6 (default) stands for displacements within 1e-4 and 1e-2 for
                         * 1 %; what is below 64 epsilon counts as that */
    int max_newton;     /* iterations per increment before it is halved, >= 1; default 30. Bodies with a single
                         * rotation per element converge linearly and take at least 300 */
    int max_iterations; /* of each linear solve, >= 1; default 20000 */
    int quasi_newton;   /* 1: the tangent SB_TANGENT_QUASI as long as each iteration halves the residual: of
                         * corotated tets several times cheaper to assemble, but convergence is linear, which
                         * pays where the tolerance is loose; default 0 */
    sb_newton newton;   /* default SB_NEWTON_AUTO */
    sb_start start;     /* default SB_START_AUTO */
    int forces_only;    /* 1: the out-of-balance force alone decides, compared with all reactions, too: for one of many
                         * solves between which loads change by more; default 0 */
    int keep_progress;  /* 1: on failure the body stays at the last converged increment; 0 (default): it
                         * returns to where it was */
    int instantaneous;  /* with Prony terms, 1: the response to a sudden load, before anything relaxes; 0
                         * (default): the one long after */
    void (*progress)(void *user, const sb_step_info *info); /* after each increment, or NULL */
    void *progress_user;
    unsigned cookie; /* set by sb_default_static_options */
} sb_static_options;

SB_API sb_static_options sb_default_static_options(void);

/* Bodies made with SB_PRECOND_AUTO whose systems conjugate gradients would take long for, thin ones and those whose
 * last solve took more than 1000 iterations, are factored (SB_PRECOND_CHOLESKY) up to 30,000 nodes; the factor is taken
 * from the allocator and given back within the call; without memory for it conjugate gradients go on. Not with tools.
 *
 * Where rounding does not let a solve meet its tolerance, it ends with success and SB_STOP_FLOOR in info->statics.
 *
 * Finds the equilibrium under the present loads and supports: Newton with the exact tangent, projected to positive
 * definite where it is not, a line search that refuses inverted elements, and adaptive load increments from the
 * loads of the last static solve (0 at first) and the present shape. Velocities become 0. options NULL: defaults.
 *
 * Materials with Prony terms: the equilibrium long after, when all has relaxed that relaxes, with nothing else
 * remembered; or (options->instantaneous) the one right after the loads changed in no time, from what is remembered.
 *
 * Errors: SB_ERROR_UNCONSTRAINED names a node of a part that can move freely; SB_ERROR_INVERTED names the element
 * that would turn inside out; SB_ERROR_DIVERGED, SB_ERROR_NOT_CONVERGED after halving the increment six times. */
SB_API sb_result sb_body_solve_static(sb_body *body, const sb_static_options *options, sb_step_info *info);

#endif /* SB_STEP_H */
