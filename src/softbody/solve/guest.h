/* guest: what is solved together with the nodes of a matrix: unknowns of its own, forces on nodes, or both. Floor 1,
 * internal.
 *
 * The system is (A + G) x = b over the nodes' displacements and the guests' unknowns; A is an sb_matrix, G what the
 * guests answer. A guest sees compact vectors only: its unknowns, then the three components of each of its nodes, in
 * doubles also where sb_real is float. It never sees the vectors of conjugate gradients, supports or threads.
 * Prescribed components of its nodes are known motion: `residual` sees them, in `multiply` they are 0, and what the
 * guest answers there is left out of the equations.
 *
 * In the step of a body all is counted from the start of the step: in `residual`, `settle` and `commit` a node's
 * components are its displacement over the step, up to where the forces balance, and unknowns that are 0 stand for no
 * motion. A step of several Newton iterations solves several systems, each for what is still to be added; a guest does
 * not see that. Its rows hold for the whole step: it is linear in it, but for what `begin` and `settle` change.
 *
 * What a needle asks of it (a rod that sticks to nodes or slips past them, in the null-space form):
 *   - unknowns that are no displacements of nodes: slip along a tangent, nodes outside: `unknown`, in any unit
 *   - nodes that follow the rod exactly, a million times stiffer than tissue: forces on them by `multiply`, and the
 *     rod's own block solve, in which those nodes take part with the blocks of A among them: `taken_count`, `begin`
 *   - known displacements and loads: `residual`
 *   - a first guess in which the rod has moved with what is known, a tolerance relative to what is left after it, and
 *     a norm in which the rod's stiffness does not count: always done
 *   - friction states guessed, contradicted and turned over, each time a new block and the solve gone on with: `settle`
 *   - several needles, rods beside the tissue (no nodes), pivoting over all of them: several guests, or one of all
 *   - factors of the step, what the nodes move by without the increment, to commit and to undo: `sbi_guest_step`,
 *     `commit`, `undo`
 * Contact has no unknowns and changes with the increment: see body/step_touch.h. Its cross terms between nodes of two
 * faces are a guest. */
#ifndef SB_GUEST_H
#define SB_GUEST_H

#include "precond.h"

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)

/* The step that is solved: what a guest needs to write its rows. Forces balance where a node has moved by d since the
 * start of the step, with
 *     v = velocity_factor d + velocity0,  a = acceleration_factor d + acceleration0,
 * which at supports is their own motion. What a guest has a mass for moves by the same rule, of its velocity v_n and
 * acceleration a_n at the start:
 *     velocity0 = known_velocity[0] v_n + known_velocity[1] a_n,
 *     acceleration0 = known_acceleration[0] v_n + known_acceleration[1] a_n.
 * At the end of the step d is then d / level, v is v_n + (v - v_n) / level, and a is a_n + (a - a_n) /
 * inertia_level. */
typedef struct sbi_guest_step {
    const sb_matrix *matrix;                  /* A, supports in it (matrix->fixed); constraints are condensed in it */
    const sb_vec3 *displacement;              /* [row_count] at the start of the step (m) */
    const sb_vec3 *velocity;                  /* [row_count] at the start (m/s) */
    const sb_vec3 *acceleration;              /* [row_count] at the start (m/s^2) */
    const sb_vec3 *velocity0, *acceleration0; /* [row_count] (m/s, m/s^2) see above */
    const sb_vec3 *present;                   /* [row_count] displacement that A is the tangent at (m) */
    int iteration;                /* of Newton: 0 as long as nothing has moved, otherwise states that were found stay */
    int starts;                   /* 1: no step yet, but the accelerations that the first one starts from, which are
                                   * acceleration_factor times the solution; `undo` follows, no `commit` */
    double dt;                    /* s; 0: static */
    double velocity_factor;       /* 1/s */
    double acceleration_factor;   /* 1/s^2 */
    double known_velocity[2];     /* 1, s */
    double known_acceleration[2]; /* 1/s, 1 */
    double level;         /* share of the step after which forces balance: 1 - alpha_f of generalised alpha, else 1 */
    double inertia_level; /* the same of inertia: 1 - alpha_m, else 1 */
    const sb_vec3 *left; /* [row_count] what is out of balance without guests (N), elastic forces less loads, where A is
                          * to tell how forces change that keep to ways which bend; NULL: it is not */
    int is_exact;        /* 1: also where that makes it indefinite */
} sbi_guest_step;

typedef struct sbi_guest {
    void *user;
    int unknown_count; /* reals of its own, >= 0 */
    double *unknown;   /* [unknown_count] in: the start; out: the solution */
    int node_count;    /* nodes that its forces act on, >= 0 */
    const int *nodes;  /* [node_count] rows of the matrix, each once */
    int taken_count; /* the first so many of `nodes` have their equations solved in its block; no two guests take one */

    /* x and y are [unknown_count + 3 node_count] */
    void (*residual)(void *user, const double *x, double *y); /* y = its loads - G x */
    void (*multiply)(void *user, const double *x, double *y); /* y = G x; symmetric, A + G positive definite */
    /* [unknown_count + 3 taken_count]: z = (G + A)^-1 r of these rows alone, or what is near: symmetric, positive
     * definite. NULL: it has no rows of its own */
    void (*precondition)(void *user, const double *r, double *z);

    /* 1: its first three unknowns are a way that all of its taken nodes go: these hold each other, and the sum of
     * forces is that of the nodes' residuals and theirs. */
    int moves_taken;

    /* 1: it has no unknowns and no forces of its own, only a stiffness between its nodes that counts in what a system
     * adds: what is in the forces of others. `residual` is then not called. */
    int is_tangent;

    /* optional */
    /* After each tangent is made, before it is solved with: takes what it needs of the step and factors its block; may
     * set `unknown`, which is a first guess in iteration 0 and what was found so far later. What it returns as an error
     * undoes the step. SB_ERROR_INDEFINITE: where the tangent was not positive definite it is called again with a
     * better one. */
    sb_result (*begin)(void *user, const sbi_guest_step *step, sb_error *error);
    /* After a solve, x the solution: 0 when it stands, 1 when the guest has changed its rows (a friction state) and the
     * solve must go on, with placed nodes where unknowns put them; 2: with nodes where they are. */
    int (*settle)(void *user, const double *x);
    /* The step is done, x is where it balances: takes over its motion. Cannot fail. */
    void (*commit)(void *user, const double *x);
    /* Taken nodes are where unknowns put them, which `precondition` keeps to first order (its result is then positive
     * definite on such motion alone): way [3 taken_count] = their displacement over the step. Solves begin with it, and
     * shapes that are tried have it. */
    void (*place)(void *user, const double *unknown, double *way);
    /* With `place`: rows [unknown_count + 3 taken_count] of a residual or a product: what taken nodes have goes to the
     * unknowns that move them, and is 0 then. Else the forces by which these nodes hold each other would have to cancel
     * in each sum of conjugate gradients (Gould, Hribar and Nocedal 2001, 6). */
    void (*condense)(void *user, double *rows);
    /* In a step of several solves: x is where it is by now, and its rows are to be those of there. */
    void (*renew)(void *user, const double *x);
    /* The step has failed, or is begun anew with other factors: as before the first `begin`. Called of each guest whose
     * `begin` was called or is missing. Its unknowns are put back already. */
    void (*undo)(void *user);
} sbi_guest;

typedef struct sbi_guests {
    const sbi_guest *const *list; /* [count] */
    int count;
} sbi_guests;

/* ---- what a solve keeps of them ---- */

typedef struct sbi_guest_work {
    const sbi_guest *guest;
    int part;                                        /* of the matrix, or of its own, that its equations belong to */
    int done;                                        /* 1: nothing is to be done in this round */
    size_t size, width;                              /* unknowns and taken components; unknowns and all components */
    double *residual, *block, *correction, *product; /* [size]; block: its own block's solution for the residual */
    double *search, *start;                          /* [unknown_count] */
    double *in, *out;                                /* [width] */
    double *base;   /* [width] what a solve starts from: nodes' increments are added to it, unknowns have it in them */
    double *first;  /* [unknown_count] as they were given to the step */
    double sums[2]; /* its share of the sums at work */
} sbi_guest_work;

/* Equations of taken nodes live in the residuals and products of their guests: those of the nodes are 0 there. So the
 * preconditioner of the matrix sees nothing of them. */
typedef struct sbi_guest_space {
    int count;
    sbi_guest_work *work; /* [count] */
    int rows_changed;     /* 1: a guest has changed its rows since its caller set it to 0 */
    double scale;         /* mean diagonal of the matrix (N/m) */
    int *part_of;         /* [row_count] part of each row, as the last solve had them; may be made anew after it */
    const sb_matrix *matrix;
    sb_real *rest, *spare; /* [row_count][3] */
    /* blocks of taken nodes while the preconditioner is made without them, and their masks */
    sb_real (*kept)[9];
    size_t kept_room, kept_count;
    unsigned char *kept_fixed;
} sbi_guest_space;

/* 1: the counts can be those of guests of so many rows. */
SBI_API int sbi_guests_have_sizes(const sbi_guests *guests, int rows);
/* SB_ERROR_INDEX (a node outside, or twice in a guest, or taken twice: error->node) or SB_ERROR_ARGUMENT. marks[rows]
 * is for scratch. */
SBI_API sb_result sbi_guests_check(const sbi_guests *guests, int rows, int *marks, sb_error *error);
/* Hands out the arrays of a space; see sbi_arena. */
SBI_API void sbi_guest_space_layout(sbi_guest_space *space, const sbi_guests *guests, const sb_matrix *matrix,
                                    sbi_arena *arena);
/* Blocks that sbi_guest_remove_taken keeps. */
SBI_API size_t sbi_guests_taken_blocks(const sbi_guests *guests, const sb_matrix *matrix);
/* Taken nodes become prescribed, to 0, and the matrix what it was, to the bit. */
SBI_API void sbi_guest_remove_taken(sbi_guest_space *space, sb_matrix *matrix);
SBI_API void sbi_guest_restore_taken(sbi_guest_space *space, sb_matrix *matrix);

/* Prescribed components of their nodes are made to meet their equations. */
SBI_API void sbi_guest_hold(sbi_guest_space *space, const sb_real *rhs, sb_real *x);
/* r += loads - G (base + x), and takes what is theirs out of r. x NULL: 0, but for prescribed components, which are
 * those of `held` (NULL: 0, too). */
SBI_API void sbi_guest_residual(sbi_guest_space *space, const sb_real *x, const sb_real *held, sb_real *r);
/* q += G p, and takes what is theirs; sums[0] = p.Gp. */
SBI_API void sbi_guest_multiply(sbi_guest_space *space, const sb_real *p, sb_real *q);
/* block = that of the residual; sums[0] = residual.block in the units of |r|^2: the force on the mean node that would
 * do as much work. */
SBI_API void sbi_guest_measure(sbi_guest_space *space);
/* x, unknowns += block, and r, residuals -= A + G times that. x, unknowns stay when x is NULL. v [row_count][3] is for
 * scratch. */
SBI_API void sbi_guest_guess(sbi_guest_space *space, sb_real *x, sb_real *r, sb_real *v);
/* The unknowns as they were given: kept, and put back. Then: unknowns += factor search, residual -= factor product, of
 * one */
SBI_API void sbi_guest_keep_start(sbi_guest_work *work);
SBI_API void sbi_guest_go_back(sbi_guest_work *work);
SBI_API void sbi_guest_advance(sbi_guest_work *work, double factor);
/* search = correction + factor search (fresh: correction) */
SBI_API void sbi_guest_direct(sbi_guest_work *work, double factor, int fresh);
/* 1: residuals are to have nothing of the preconditioner's coarse space, and keep to that: the coarse space of a matrix
 * is one of all equations as long as guests act on taken nodes alone. */
SBI_API int sbi_guest_is_deflated(const sbi_guest_space *space, const sb_preconditioner *preconditioner);
/* z, correction = M^-1 of r, residual, M symmetric and positive definite, on residuals as above where they are
 * deflated. size: as of sbi_precond_apply. */
SBI_API void sbi_guest_precondition(sbi_guest_space *space, sb_preconditioner *preconditioner, const sb_real *r,
                                    sb_real *z, double size);
/* sums = residual.correction, product.correction (fresh: 0) */
SBI_API void sbi_guest_dots(sbi_guest_work *work, int fresh);
/* sum += residuals of its taken nodes, and of its unknowns where these move them */
SBI_API void sbi_guest_add_taken(const sbi_guest_work *work, double sum[3]);
/* x of all guests to their settle calls; 1 when one has changed its rows. Its placed nodes go where it puts them. */
SBI_API int sbi_guest_settle(sbi_guest_space *space, sb_real *x);

/* ---- for steps of several solves ---- */
/* The base moves by a share of the solution x: by `share` along free components and unknowns, by `held` along
 * prescribed components. Unknowns are then those of the base. */
SBI_API void sbi_guest_move_base(sbi_guest_space *space, const sb_real *x, double share, double held);
/* A guest's forces at the base, in out. */
SBI_API void sbi_guest_force(sbi_guest_work *work);
/* The guests' part of the potential from the base to the solution x: t linear + t^2 quadratic. */
SBI_API void sbi_guest_line(sbi_guest_space *space, const sb_real *x, double *linear, double *quadratic);
#endif

#endif /* SB_GUEST_H */
