/* step_explicit: central differences, the part of step that solves no systems. Floor 3, internal. */
#ifndef SB_STEP_EXPLICIT_H
#define SB_STEP_EXPLICIT_H

#include "body_private.h"
#include "step.h"

/* Times that a call is done again with shorter substeps. */
enum { SBI_EXPLICIT_CAUTION = 3 };

/* Moves the body by dt (s) in as many substeps as stability needs; caution 0 .. SBI_EXPLICIT_CAUTION makes them
 * shorter and the looks at the stable step more frequent. body->start and the dead loads in body->external are up to
 * date. On failure the state is anywhere in between: the caller undoes it, and body->guard. */
SBI_API sb_result sbi_explicit_run(sb_body *body, sb_real dt, int caution, sb_step_info *info);

/* Takes note of a call that went well; after a run of them the next may be bolder. */
SBI_API void sbi_explicit_calm(sb_body *body, int caution);
/* The stable step (s) of a stiffness with the masses of all axes (kg; 0: the axis stays out), NULL: the body's lumped
 * ones; not positive or not finite when there is none. Overwrites the body's work vectors. */
SBI_API sb_real sbi_explicit_bound(sb_body *body, const sb_matrix *matrix, const sb_vec3 *masses);

#endif /* SB_STEP_EXPLICIT_H */
