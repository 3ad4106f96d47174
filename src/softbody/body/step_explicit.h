/* step_explicit: central differences, the part of step that solves no systems. Floor 3, internal. */
#ifndef SB_STEP_EXPLICIT_H
#define SB_STEP_EXPLICIT_H

#include <math.h>

#include "body_private.h"
#include "step.h"

/* Times that a call is done again with shorter substeps. */
enum { SBI_EXPLICIT_CAUTION = 3 };

/* Moves the body by dt (s) in as many substeps as stability needs; caution 0 .. SBI_EXPLICIT_CAUTION makes them
 * shorter and the looks at the stable step more frequent. body->start and the dead loads in body->external are up to
 * date. On failure the state is anywhere in between: the caller undoes it, and body->guard. */
SBI_API sb_result sbi_explicit_run(sb_body *body, sb_real dt, int caution, sb_step_info *info);

/* Substeps that are needed for the rest of the way. A thousandth of a substep more or less is rounding. */
SB_INLINE double sbi_explicit_count(sb_real left, sb_real longest)
{
    double count = ceil((double)left / (double)longest - 1e-3);
    return count < 1 ? 1 : count;
}

/* Takes note of a call that went well; after a run of them the next may be bolder. */
SBI_API void sbi_explicit_calm(sb_body *body, int caution);
/* The stable step (s) of a stiffness with the masses of all axes (kg; 0: the axis stays out), NULL: the body's lumped
 * ones; not positive or not finite when there is none. Overwrites the body's work vectors. */
SBI_API sb_real sbi_explicit_bound(sb_body *body, const sb_matrix *matrix, const sb_vec3 *masses);

/* ---- step_explicit_touch.c: of a body with something that touches it, in the order of calls ---- */
/* Begins a substep of what is left (s) of a call; *count: substeps that it takes, of at most `longest` (s) each, and of
 * less where something is near. tries: caution. */
SBI_API sb_result sbi_explicit_begin_touch(sb_body *body, sb_real left, sb_real longest, int tries, double *count,
                                           sb_error *error);
/* The body has moved by body->increment: forces of contact there. SB_ERROR_DIVERGED: something may have passed
 * through. */
SBI_API sb_result sbi_explicit_meet_touch(sb_body *body, sb_error *error);
/* body->follower += forces of contact: as they were met; before the first substep, as the last step left them. */
SBI_API void sbi_explicit_add_touch(sb_body *body, int met);
/* Energy (J) of the velocity that forces of contact, as they were met, give in half a substep of h (s): what they may
 * bring without a way to work on, where they are new. */
SBI_API double sbi_explicit_touch_swing(const sb_body *body, sb_real h);
SBI_API void sbi_explicit_commit_touch(sb_body *body);

#endif /* SB_STEP_EXPLICIT_H */
