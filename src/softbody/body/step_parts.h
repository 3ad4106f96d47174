/* step_parts: an implicit step in parts, for what is solved together with a body. Floor 3, internal, made for guests.
 *
 *     sbi_step step;
 *     sb_result result = sbi_step_begin(body, dt, guests, guest_count, info, &step);
 *     do {
 *         while (result == SB_OK && !step.done) {
 *             result = sbi_step_solve(&step);
 *             if (result == SB_OK)
 *                 result = sbi_step_advance(&step);
 *         }
 *         if (result == SB_OK)
 *             result = sbi_step_commit(&step);
 *     } while (sbi_step_begin_again(&step, &result));
 *     return result == SB_OK ? result : sbi_step_undo(&step, result);
 *
 * is sbi_body_step_with, and without guests sb_body_step. A linearised step goes once through the inner loop. From
 * begin to commit or undo nothing else may change the body.
 *
 * With guests (solve/guest.h) the residual is that of the body less the guests' forces, and their own rows: an iterated
 * step has converged when both are small enough. A guest's rows count by the motion that they stand for, as in
 * conjugate gradients. Where a line search shortens the increment, unknowns of guests are shortened with it. Reactions
 * of supports are what they hold of guests, too: the sum of all forces on the body, those of guests included, is its
 * change of momentum. Where the acceleration that Newmark and generalised alpha start from is not known (a body's first
 * step, or the first after displacements were set, constraints changed, a static solve), guests take part in finding
 * it. */
#ifndef SB_STEP_PARTS_H
#define SB_STEP_PARTS_H

#include "../solve/guest.h"
#include "step.h"

/* One Newton iteration is A du = -r, see step_residual.c. Guests read; only the parts of the step write. */
typedef struct sbi_step {
    sb_body *body;
    sb_step_info *info;
    sb_step_info own_info;   /* where the caller wants none */
    double begun;            /* on the body's clock (s) */
    int dynamic;             /* 1: a time step; 0: a static solve */
    int done;                /* 1: nothing is left to be solved */
    int iteration;           /* of Newton, from 0 */
    sb_tangent_kind kind;    /* of the tangent in A */
    sbi_guests given;        /* guests of the step's caller */
    sbi_guests guests;       /* solved together with the body: those, and what contact couples */
    int guests_begun;        /* those of them that have begun */
    double guests_left;      /* share of the way by their present rows that they have not gone: increments were cut
                              * short */
    int guests_lag;          /* 1: the step failed for that */
    int starts;              /* 1: this is no step but the search for the accelerations that it starts from */
    struct sbi_touch *touch; /* what touches the body in this step, or NULL: nothing does */
    int touch_begun;
    int moved; /* 1: what touches has moved the end of the step away from its balance, which body->previous keeps */
    int tries; /* how often the step began anew because something may have passed through a tool, or tools that move may
                * have made it fail */
    int wide;  /* 1: it began anew because what touches had looked for too little */
    sb_real part; /* share of what is left of a divided step; else 1 */
    int patience; /* times the cap on iterations that guests are waited for; 0: they may be left behind */

    /* what is solved */
    sb_real dt;     /* s */
    sb_real hold;   /* factor of the mass in A of a static iteration that nothing else may hold (1/s^2) */
    sb_real cv, ca; /* dv/du (1/s) and da/du (1/s^2) */
    sb_real known_velocity[2], known_acceleration[2]; /* factors of v and a at the start in v and a, of free axes */
    sb_real load_factor;                              /* share of the way from start to target the supports go */
    sb_real loads_factor;     /* share of the way from the values of the last static solve to the present ones that
                               * loads that follow the body have: 1 in a time step */
    sb_real level;            /* share of the step after which u, v and the forces balance: 1, or 1 - alpha_f */
    sb_real inertia_level;    /* the same for a: 1, or 1 - alpha_m */
    sb_real radius;           /* spectral radius of generalised alpha */
    sb_real tolerance;        /* of the residual; a linearised step has none */
    sb_real linear_tolerance; /* of the linear solves; adaptive when 0 */
    int max_newton, max_iterations;
    int line_search;
    int linearised;         /* one iteration, taken as it is */
    int lagged_damping;     /* D's K is the one at the start of the step, in body->damping_blocks; a linearised step
                             * has it in A already */
    int has_velocity;       /* v may differ from 0 at the current u */
    int needs_acceleration; /* 1: the step first solves M a = f */
    int keeps_acceleration; /* 1: it leaves the acceleration that it found */
    int pushed;             /* 1: live_push.c holds something in this step, */
    sb_real push;           /* and its factor in A; 0: there is none */
    int keeps;              /* 1: the tangent of a step before stands for A, */
    int notes;              /* 1: or this one's is to be kept: see step_kept.c */
    int unassembled;        /* 1: A is not assembled: see step_unassembled.c */
    sb_real support_scale;  /* and its entries on supported axes (N/m) */

    /* where it is */
    int moves_supports;      /* the present increment moves supported nodes or closes gaps of constraints */
    int opens_gaps;          /* the part of the increment that closes gaps is still to be added to the solution */
    sb_real scale;           /* largest force (N), to compare residuals with */
    sb_real load_size;       /* times epsilon: rounding of the forces of springs (N) */
    sb_real norm, last_norm; /* residual on free axes (N), now and one iteration ago */
    sb_real energy;          /* elastic (J), at the current u; valid when energy_known */
    int energy_known;
    int cautious; /* 1: the last increment had to be cut short, so project the next tangent */
    int quasi;    /* 1: the quasi tangent, as long as each iteration halves the residual */

    /* when a static increment is done: step_done.c */
    int mixed;               /* > 0: mixed points, for so many more load increments that fail */
    int rises;               /* how often running the next has risen: */
    sb_real expected;        /* r.K^-1 r of the last system (J) */
    int slow;                /* 1: conjugate gradients have taken long */
    sb_preconditioner *kept; /* what a complete factor stands in for; NULL: it does not */
    int forces_only;         /* see sb_static_options */
    sb_real held_scale;      /* as scale, but with the reactions of supports that rest (N) */
    sb_real rounding;        /* in the residual (N), as far as displacements and moduli tell */
    sb_real least;           /* smallest sb_static_report.energy of the increment so far */
    int stalls;              /* checks since it last fell to a half */
} sbi_step;

/* Starts a step of dt (s): keeps what undo gives back, then makes the first linear system: residual, tangent,
 * constraints and preconditioner. guests[guest_count] (NULL where there are none) are used until commit or undo; what
 * their solves need is taken here, so that later nothing is allocated. info may be NULL. SB_ERROR_ARGUMENT,
 * SB_ERROR_INDEX (see sbi_guests_check), SB_ERROR_MEMORY; SB_ERROR_UNSUPPORTED of a body with explicit steps, and of a
 * guest on a node with an axis that constraints eliminate (error.node; its masters serve); what the material, the
 * solver or a guest refuses. */
SBI_API sb_result sbi_step_begin(sb_body *body, sb_real dt, const sbi_guest *const *guests, int guest_count,
                                 sb_step_info *info, sbi_step *step);
/* Solves the present linear system for the body's increment and the guests' unknowns. Where the exact tangent is not
 * positive definite, it is made anew, projected, and solved again. */
SBI_API sb_result sbi_step_solve(sbi_step *step);
/* Takes the increment or, where a line search watches it, a share of it. Unless done is 1 afterwards, the next linear
 * system is ready. */
SBI_API sb_result sbi_step_advance(sbi_step *step);
/* Ends a step that is done: velocities, accelerations, reactions, loads' readings, what materials remember; the
 * recorder is told. A failure leaves the step open, as do all failures above. */
SBI_API sb_result sbi_step_commit(sbi_step *step);
/* 1 when the step may yet succeed in another way: *result, which failed, is then that of a new beginning. Generalised
 * alpha extrapolates: where the material does not admit the end, the balance is tried at the end, where the line search
 * sees it. */
SBI_API int sbi_step_begin_again(sbi_step *step, sb_result *result);
/* Ends a step that failed: body and guests are as they were before, the recorder is told, info says why. Returns
 * result. */
SBI_API sb_result sbi_step_undo(sbi_step *step, sb_result result);
/* All of it: the loop above. With guest_count 0 sb_body_step, also of explicit bodies. Guests may be left behind, see
 * sbi_step_part. */
SBI_API sb_result sbi_body_step_with(sb_body *body, sb_real dt, const sbi_guest *const *guests, int guest_count,
                                     sb_step_info *info);

/* A part of a step that its caller divides, from the share `begin` of it (0 in the first part) to the share `end` (1 in
 * the last): supports and tools go so much of their ways.
 *
 * Where each increment was cut short, guests have gone a share of their way only, and their loads (a sleeve that moves)
 * all of it: what they are held by would be the force of that gap, of thousands of newtons in a needle. So an iterated
 * step whose guests' rows do not meet the tolerance at its cap goes on for `patience` times the body's cap on
 * iterations, then it fails with SB_ERROR_DIVERGED; a linearised one whose increment was cut short fails at once. 1:
 * the caller rather divides it further. 0: the step is taken as it is. */
typedef struct sbi_step_part {
    sb_real begin, end;
    int patience;
} sbi_step_part;
/* The same of such a part, which is not divided any further. */
SBI_API sb_result sbi_body_step_part(sb_body *body, sb_real dt, const sbi_guest *const *guests, int guest_count,
                                     const sbi_step_part *part, sb_step_info *info);

#endif /* SB_STEP_PARTS_H */
