/* step_guess: shapes that come from elsewhere, a network: how good they are, and what a static solve starts from in
 * their place. Floor 3, internal. */
#ifndef SB_STEP_GUESS_H
#define SB_STEP_GUESS_H

#include "step.h"

/* A displacement as a static solve under the present loads sees it. */
typedef struct sbi_guess {
    sb_real force;                /* |out-of-balance force| on free axes (N) */
    sb_real residual;             /* the same as sb_static_report.force */
    sb_real from_rest, from_last; /* its potential above that of rest, and of the present state, both with supports
                                   * where they belong (J); INFINITY where the material does not admit it, -INFINITY
                                   * where it does not admit these */
} sbi_guess;

/* Puts supports and slaves of u where they belong. */
SBI_API void sbi_guess_settle(const sb_body *body, sb_vec3 *u);
/* Weighs u, which has been settled. scratch: [node_count]. The body stays as it is. SB_ERROR_INVERTED naming the
 * element, SB_ERROR_DIVERGED where forces overflow. Not with tools. */
SBI_API sb_result sbi_guess_weigh(sb_body *body, const sb_vec3 *u, sb_vec3 *scratch, sbi_guess *guess, sb_error *error);
/* u becomes the equilibrium of corotated materials with the same moduli and with the rotations of u held, which one
 * system finds. Displacements of a network have noise that volume makes large forces of, while their rotations are
 * good. Allocates nothing. On failure (what the solver refuses) u and the body are as before. */
SBI_API sb_result sbi_guess_smooth(sb_body *body, sb_vec3 *u, sb_error *error);

#endif /* SB_STEP_GUESS_H */
