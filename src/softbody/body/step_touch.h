/* step_touch: what touches a body: forces on its surface that change while a step is solved, as those of contact do.
 * Floor 3, internal.
 *
 * Unlike a guest (solve/guest.h) it has no unknowns, but is nonlinear. A step of one iteration solves
 *     (A + K) x' = b + F(x) + K x
 * for the whole increment x' again and again, F and K at the increment x before: a semi-smooth Newton iteration in
 * which forces, tangent A and preconditioner of the tissue are made once. A step of several iterations has F in its
 * residual and K in its tangent like any load's. Between the nodes of each face that it acts on the matrix has blocks
 * already, so that nothing is made anew. What links nodes of two faces has none: conjugate gradients multiply by it
 * beside the matrix.
 *
 * It sees its own nodes only: in all calls below arrays are [node_count], in the order of `nodes`. du is the nodes'
 * displacement since the start of the step. */
#ifndef SB_STEP_TOUCH_H
#define SB_STEP_TOUCH_H

#include "../solve/guest.h"
#include "body.h"

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)

/* The step that begins. */
typedef struct sbi_touch_step {
    const sb_matrix *matrix; /* A before supports and constraints: what stiffness is measured by (N/m) */
    const sb_vec3 *start; /* [rows] displacement at the start of the step, or of the increment of a static solve (m) */
    const sb_vec3 *velocity; /* [rows] at the start (m/s) */
    sb_real dt;              /* s; 0: static */
    sb_real level;  /* share of the step after which forces balance: 1 - alpha_f of generalised alpha, else 1 */
    sb_real factor; /* share of the way of a static solve; 1 in a time step */
    int stage;      /* increments of a static solve that have converged before; 0 in a time step */
    int tries;      /* how often this step was refused or failed already: each time it asks for less motion */
    int linearised; /* 1: bounds of friction may be guessed at first, since they are renewed and solved for again */
    int wide;       /* 1: begin looks as far as it ever does, since with less a step like this one missed something */
    sb_real whole_stiff, whole_mass; /* A of the caller's whole step, of which this is a part, is so much of A and of
                                      * the mass (1/s^2); else 1 and 0 */
    sb_real part;                    /* share of what is left of a divided step, and of its motion; else 1 */
    const sb_real *masses; /* [rows] of an explicit substep (kg), whose matrix is NULL; NULL: the step is implicit */
    sb_real rate; /* of one: 1/s^2, no pattern of motion may have more stiffness of contact than so much of its mass */
} sbi_touch_step;

typedef struct sbi_touch {
    void *user;
    int max_iterations; /* of a step of one iteration, >= 1 */
    sb_real stiffening; /* of explicit substeps: `rate` over the square of the body's own highest frequency */

    /* from begin to the end of the step, written by the owner */
    int node_count;
    const int *nodes; /* [node_count] rows of the matrix, each once */
    int touching;     /* points of contact at the last evaluation */
    int links;     /* 1: K of it has a part between nodes without a block, see `multiply_links`; stays after the step */
    int refused;   /* 1: accept or begin refused a step, which may succeed in parts; written by the step */
    int apart;     /* 1: it did so for motion that is not its tools': less of theirs would not help; the owner's */
    int parts;     /* what begin would have a step divided into that it refuses; the owner's */
    int foresees;  /* 1: bounds of friction are near what they will be from the first guess on; the owner's */
    int missed;    /* 1: accept refuses a step in which something may have come near that begin did not look at, as it
                    * would in a wide one; the owner's */
    sb_real share; /* of the caller's step that the one under way is; the step's */
    int steady;    /* 1: the stiffness of contact is to be that of the caller's whole step; the step's */
    int mended;    /* 1: motion was taken out of a part of the caller's step; the step's */
    int is_last;   /* 1: what is refused now will not be divided (any further); the step's */
    sb_vec3 *force; /* on the nodes (N), at the last evaluation */
    double noise;   /* N: norm of what rounding of places makes in them; from begin on */
    /* A part of K between nodes of no common face, which has no blocks in the matrix; a tangent. From begin on; without
     * nodes: there is none. Where constraints eliminate nodes it is left out of K, which is then too stiff: it costs
     * iterations, not accuracy. */
    sbi_guest coupling;
    /* room for the step: */
    sb_vec3 *du;              /* (m) what it asks forces at */
    sb_vec3 *linear;          /* F + K x of the system that is solved (N), without masked axes */
    sb_vec3 *left;            /* the same less K x' (N), x' its solution */
    sb_vec3 *way;             /* x' - x (m) */
    sb_vec3 *kept;            /* the right-hand side without contact (N) */
    sb_vec3 *whole, *product; /* [rows] where there may be links */

    /* written by the step, for who reads */
    int couples;            /* 1: K in `multiply` has the part of `coupling` in it; never in `add_blocks` */
    int iterations, capped; /* 1: max_iterations ended it */
    sb_real residual;       /* what contact's forces are off by at the end, of the largest force */

    sb_result (*begin)(void *user, const sbi_touch_step *step, sb_error *error);
    /* Forces and stiffness at du. renew: bounds of friction are those of here, else those of the last renewal. */
    void (*evaluate)(void *user, const sb_vec3 *du, int renew);
    /* out = K x, K of the last evaluation, without masked axes. masked [rows] axes as bits; NULL: none. */
    void (*multiply)(void *user, const unsigned char *masked, const sb_vec3 *x, sb_vec3 *out);
    /* matrix += K without masked axes; and what it was before, to the bit. */
    void (*add_blocks)(void *user, const unsigned char *masked, sb_matrix *matrix);
    void (*restore_blocks)(void *user, sb_matrix *matrix);
    /* out [rows] += C x [rows], without masked axes: what of K add_blocks leaves out. Returns x.Cx. */
    double (*multiply_links)(void *user, const unsigned char *masked, const sb_vec3 *x, sb_vec3 *out);
    /* An increment of a static solve has converged: 1 when it must be solved again with what was remembered of it, for
     * the round-th time; 0: the increment is done; -1: it went too far, a shorter one is to be tried. */
    int (*balance)(void *user, int round);
    /* out [rows] += factor times the forces (N) of the last step or increment that was done. */
    void (*add_done)(void *user, sb_real factor, sb_vec3 *out);
    /* 1: displacements u [rows] may stand as the end of the step; 0: something may have passed through. */
    int (*accept)(void *user, const sb_vec3 *u);
    /* Takes out of u [rows], momentum left as it is, the motion by which parts of the body come too deep into each
     * other. 1: u has changed. */
    int (*hold)(void *user, sb_vec3 *u);
    /* Takes out of u [rows] the motion by which parts of the body pass through each other, momentum left as it is, so
     * that accept refuses it only for tools; whole: that of whole organs, which changes no shapes. 1: u has changed. */
    int (*mend)(void *user, sb_vec3 *u, int whole);
    /* Organs stay in u [rows] as they were at the start of the step where accept would refuse it for tools, which stay
     * in the last of `tries`. */
    void (*stop)(void *user, sb_vec3 *u);
    /* After these: takes out of the velocities at the end of the step, v [rows], momentum left as it is, what would
     * bring together again what they hold apart. u [rows]: the displacements that they left. */
    void (*brake)(void *user, const sb_vec3 *u, sb_vec3 *v);
    /* The step is done, or has failed: as before `begin`. Neither can fail. */
    void (*commit)(void *user);
    void (*undo)(void *user);
    /* Keeps what steps that are done have changed in a block of kept_size bytes (aligned as for doubles), which no
     * step but a call that adds tools makes larger; and goes back to it. block NULL: one of its own, for static solves
     * and for steps that a body divides. 0: no memory to follow a mesh that has changed since the last step, or since
     * it was kept; it may be tried again. */
    size_t (*kept_size)(const void *user);
    int (*keep)(void *user, void *block);
    int (*rewind)(void *user, const void *block);
} sbi_touch;

/* Room for what a divided step gives back: before something touches the body, and again where more loads or another
 * mesh need more. SB_ERROR_MEMORY. */
SBI_API sb_result sbi_body_reserve_substeps(sb_body *body, sb_error *error);
/* From now on it takes part in all implicit steps and static solves of the body; NULL: nothing does. */
SBI_API void sbi_body_set_touch(sb_body *body, sbi_touch *touch);
SBI_API sbi_touch *sbi_body_get_touch(const sb_body *body);
SBI_API sb_real sbi_body_diagonal_mass(const sb_body *body, int node); /* kg, of the mass matrix */
/* Who keeps it for steps that it may take back (needles): asked for room whenever kept_size has grown. */
typedef struct sbi_touch_keeper {
    void *user;
    int (*reserve)(void *user); /* 0: no memory, and all is as before */
} sbi_touch_keeper;
SBI_API void sbi_body_set_touch_keeper(sb_body *body, const sbi_touch_keeper *keeper); /* one at a time; NULL: none */
/* 0: its keeper has no memory. */
SBI_API int sbi_body_reserve_touch_kept(const sb_body *body);
/* Takes beforehand what steps need for a coupling of so many nodes. SB_ERROR_MEMORY leaves the body as it was. */
SBI_API sb_result sbi_body_reserve_coupling(sb_body *body, int nodes, sb_error *error);
/* x [rows] = what the system of the last implicit step or static solve, with its contact and supported axes held,
 * answers to forces rhs [rows] (N), which are changed, to a relative tolerance. With that step's matrix and
 * preconditioner: nothing that makes others may have been asked of the body since. Without guests. Allocates nothing.
 * What sb_pcg_solve says, but for SB_ERROR_NOT_CONVERGED: x is then as near as it got. */
SBI_API sb_result sbi_body_solve_column(sb_body *body, sb_vec3 *rhs, sb_vec3 *x, sb_real tolerance);
#endif

#endif /* SB_STEP_TOUCH_H */
