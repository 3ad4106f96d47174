/* pcg: preconditioned conjugate gradients. Floor 1. */
#ifndef SB_PCG_H
#define SB_PCG_H

#include "guest.h"
#include "precond.h"

typedef struct sb_pcg_options {
    double tolerance; /* stop when |rhs - A x| <= tolerance |rhs| in each connected part of A, >= 0; default 1e-6 (float
                       * builds: 1e-3) */
    int max_iterations;  /* bound of the work, >= 0; default 1000 */
    const sb_jobs *jobs; /* NULL (default): inline; the result is the same for any number of threads */
} sb_pcg_options;

typedef struct sb_pcg_info {
    int iterations;         /* products with A in search directions */
    double residual;        /* |rhs - A x| / |rhs| of the returned x, in the part where it is largest */
    int residual_is_true;   /* 1: computed from x; 0: by the recurrence, which drifts by epsilon |A| |x| */
    int negative_curvature; /* 1: a direction with p.Ap <= 0 ended the solve: A is not positive definite */
    int capped;             /* 1: max_iterations ended the solve */
} sb_pcg_info;

/* Vectors of one solve, to be kept between solves. Not for two solves at a time. */
typedef struct sb_pcg_workspace {
    int row_count;
    sb_real *start, *residual, *search, *direction, *product; /* [row_count][3] */
    double *partial;                                          /* [chunks][2] sums of each chunk of rows */
    void *parts;                                              /* what is kept of each connected part */
    void *memory;
    void *guests; /* internal: what is kept of those that are solved together with the matrix; NULL: there were none */
    size_t guest_bytes;
    const struct sbi_pcg_extra *extra;          /* internal: what is added to the matrix; NULL: nothing */
    const struct sbi_pcg_operator *unassembled; /* internal: what stands for matrix and preconditioner; NULL: they do */
    struct sbi_pcg_record *record;              /* internal: what is known of the last solve */
    sb_allocator allocator;
} sb_pcg_workspace;

/* The defaults named at the fields. */
SB_API sb_pcg_options sb_default_pcg_options(void);

/* Takes the vectors for systems of row_count >= 1 nodes. SB_ERROR_ARGUMENT or SB_ERROR_MEMORY leave
 * *workspace untouched. Release with sb_pcg_workspace_free. allocator NULL: malloc. */
SB_API sb_result sb_pcg_workspace_create(int row_count, const sb_allocator *allocator, sb_pcg_workspace *workspace,
                                         sb_error *error);
SB_API void sb_pcg_workspace_free(sb_pcg_workspace *workspace);

/* Solves A x = rhs for a symmetric positive definite A.
 * preconditioner  up to date with A; NULL: none
 * rhs             [row_count][3]
 * x               [row_count][3] in: the start; out: the solution. rhs = 0 gives x = 0 whatever the start, in each part
 * options         NULL: defaults
 * info            filled in every case but SB_ERROR_ARGUMENT; may be NULL
 * Returns SB_OK;
 *   SB_ERROR_NOT_CONVERGED  the cap was reached, or rounding stops progress (info->capped tells which); x is
 *                           the last
 *                           iterate, good enough for a real-time step that had no time for more
 *   SB_ERROR_INDEFINITE     p.Ap <= 0 (info->negative_curvature) or a preconditioner that is not positive
 *                           definite;
 *                           x is the last iterate before
 *   SB_ERROR_DIVERGED       a NaN or infinity, in the input or grown; x is the start again
 *   SB_ERROR_ARGUMENT       sizes that do not match, options out of range; x untouched
 * Parts that the pattern of A does not connect are solved as if each were alone, side by side: with step lengths of its
 * own and to a residual relative to its own rhs, so that a crumb of 1e-9 of the forces is as good as the organ beside
 * it. Parts whose rhs is below some 1e-31 of the whole are left alone, which is what single precision holds beside 1.
 * With levels of one's own that couple parts (sb_preconditioner_def) all rows are one part. Iterations are those of the
 * part that needs most.
 * Tolerances whose cube is below SB_EPSILON are near what the recurrence can hold: there the true residual is
 * computed at the end, and the iteration goes on from it if it has drifted. No x of sb_real can have a
 * smaller residual than about SB_EPSILON |A| |x|: in float builds that is 1e-4 |rhs| for a soft beam of 2,000
 * nodes. Sums are taken in double over fixed chunks of rows, added in order: same bits for any number of
 * threads.
 * Multigrid has the matrix of its update in 32 bits an entry, which has half the bytes, but where moduli jump (and in
 * float builds): directions are multiplied by that one, the true residual is computed with the matrix itself, and where
 * the two part the iteration goes on from the true one, at last without the other. So the residual holds for the matrix
 * given whatever the preconditioner was made of. */
SB_API sb_result sb_pcg_solve(const sb_matrix *matrix, sb_preconditioner *preconditioner, const sb_real *rhs,
                              sb_real *x, const sb_pcg_options *options, sb_pcg_workspace *workspace,
                              sb_pcg_info *info);

/* ---- internal ------------------------------------------------------------------------------------------ */

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* C of (A + C) x = rhs, for couplings that A has no blocks for: symmetric, A + C positive definite. While a workspace
 * has one all rows are one part, and multigrid's matrix in 32 bits is not used. The preconditioner is that of A. */
typedef struct sbi_pcg_extra {
    void *user;
    /* y += C x, both [row_count][3] and 0 or left as they are where A prescribes; returns x.Cx. On the calling thread
     */
    double (*multiply)(void *user, const sb_real *x, sb_real *y);
} sbi_pcg_extra;

/* A of A x = rhs where the matrix has no values: it tells pattern, parts and what is prescribed (matrix->fixed). While
 * a workspace has one the preconditioner is not looked at. Not with guests. */
typedef struct sbi_pcg_operator {
    void *user;
    void (*multiply)(void *user, const sb_real *x,
                     sb_real *y); /* y = A x, both [row_count][3]. On the calling thread */
    const sb_real *diagonal;      /* [row_count] > 0: z = r over it; NULL: z = r */
} sbi_pcg_operator;

/* Momentum is kept to the tolerance of forces from outside, or of this share of those within that were out of balance
 * where motion went on as it was: of a touch that is next to nothing it would be kept to rounding. */
#define SBI_PCG_WITHIN 0.01

/* What is known of a workspace's last solve. */
typedef struct sbi_pcg_record {
    double softest; /* 1 / the smallest eigenvalue of M^-1 A that it saw; 0: none */
    double begun;   /* N: |r| at the start of the step's first system, without what touches the body */
    double met;     /* N: norm of what touched there */
    int part_count; /* parts of that one */
    int loose;      /* axes on which nothing holds any of them */
    int is_left;    /* 1: the workspace's residual is that of the x that it returned */
} sbi_pcg_record;

/* What the step of a body asks of a solve beside its options. What touches the body has changing forces, which
 * the right-hand side has in it; the tolerance is of those of now, or of what the step began with beside them. */
typedef struct sbi_pcg_demand {
    int current;          /* 1: the preconditioner was updated with this very matrix; 0: it has changed since then */
    int later;            /* 1: the step's second system or a later one */
    int goes_on;          /* 1: the owner has made the residual that was left that of this system, at the x left */
    int is_touched;       /* 0: the tolerance is of |rhs| in the first system */
    int node_count;       /* what touches: */
    const int *nodes;     /* [node_count] rows, each once */
    const sb_vec3 *force; /* [node_count] (N), at the start x */
    double outside;       /* N: magnitudes of all forces from outside, what touches included; < 0: not looked at */
    const sb_real
        *bend; /* [row_count][3] which way the solution may be off the start x, of any length; NULL: not known */
    const sb_real *product; /* [row_count][3] A x of the start x, where the caller has it; NULL: it is made */
} sbi_pcg_demand;

/* Of a step without anything special: of the matrix that the preconditioner was updated with. */
SBI_API sbi_pcg_demand sbi_pcg_step_demand(void);

/* The same for the step of a body, with a preconditioner that was updated with this very matrix. The product in 32 bits
 * is then known to differ by no more than its rounding, and a residual that meets the tolerance with that added needs
 * no look at the matrix. Parts without a prescribed component along an axis keep their momentum along it: the sum of
 * the residual there must be no more than tolerance times that of the magnitudes at the start x. */
SBI_API sb_result sbi_pcg_solve_current(const sb_matrix *matrix, sb_preconditioner *preconditioner, const sb_real *rhs,
                                        sb_real *x, const sb_pcg_options *options, sb_pcg_workspace *workspace,
                                        sb_pcg_info *info);

/* Takes what solves with these guests need beside the workspace, which keeps it for others that need no more; to be
 * called whenever guests, their sizes or nodes, or the pattern of the matrix have changed. SB_ERROR_ARGUMENT,
 * SB_ERROR_INDEX (error->node; see sbi_guests_check) and SB_ERROR_MEMORY leave the workspace as it was. */
SBI_API sb_result sbi_pcg_reserve_guests(sb_pcg_workspace *workspace, const sb_matrix *matrix, const sbi_guests *guests,
                                         sb_error *error);
/* Takes beforehand what solves usually need with one guest of so many unknowns that takes so many nodes, in a matrix
 * that grows to so many rows. SB_ERROR_MEMORY leaves the workspace as it was. */
SBI_API sb_result sbi_pcg_reserve_guest_room(sb_pcg_workspace *workspace, const sb_matrix *matrix, int rows,
                                             int unknowns, int nodes, sb_error *error);
/* What was reserved, for steps of several solves; NULL: nothing was. */
SBI_API sbi_guest_space *sbi_pcg_guests(const sb_pcg_workspace *workspace);
/* The room that another workspace has for guests, of so many nodes there as here or more, so that the first solve of a
 * matrix that was made anew allocates nothing. */
SBI_API sb_result sbi_pcg_keep_guest_room(sb_pcg_workspace *workspace, const sb_pcg_workspace *from, int rows,
                                          int from_rows, sb_error *error);
/* Makes the preconditioner of a matrix that is solved with guests: as sb_preconditioner_update, but with the nodes that
 * guests take held, whose equations their own blocks solve. The matrix is as before in the end. Also
 * SB_ERROR_ARGUMENT: no space was reserved for them. */
SBI_API sb_result sbi_pcg_update_preconditioner(sb_preconditioner *preconditioner, sb_matrix *matrix,
                                                const sb_vec3 *positions, const sbi_guests *guests,
                                                sb_pcg_workspace *workspace, sb_error *error);
/* Solves (A + G) x = b as sbi_pcg_solve_current does, with guests that space was reserved for and a preconditioner of
 * sbi_pcg_update_preconditioner (with another one it takes more iterations). Guests are called on the calling thread,
 * one after the other, so that bits do not depend on threads. Allocates nothing.
 * Parts that a guest's nodes lie in are one part. What its tolerance is relative to is the residual that is left when
 * the guests' own blocks are solved from the base (see sbi_guest_move_base), which is at rest to begin with, so that
 * loads on what is stiff in itself do not count; and their rows count by the motion they stand for (sqrt of residual .
 * block, in the mean node's units), so that units and stiffness do not. After each solve every guest may settle: when
 * one has changed its rows the iteration goes on from where it is, with a tenth of the tolerance from the fourth solve
 * on, since states that hang on little would turn over and back. SB_ERROR_DIVERGED: unknowns of guests are those of the
 * start, too. A matrix in 32 bits that multigrid has is not used when nodes are taken, since it is without them.
 * demand: NULL: as sbi_pcg_solve_current. Momentum is kept to the tolerance in later systems, too, of what the first
 * one began with. */
SBI_API sb_result sbi_pcg_solve_guests(const sb_matrix *matrix, sb_preconditioner *preconditioner, const sb_real *rhs,
                                       sb_real *x, const sbi_guests *guests, const sb_pcg_options *options,
                                       sb_pcg_workspace *workspace, const sbi_pcg_demand *demand, sb_pcg_info *info);
#endif

#endif /* SB_PCG_H */
