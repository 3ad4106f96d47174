/* step_direct: static solves whose systems are factored where conjugate gradients would take long. */
#include "step_private.h"

enum { SBI_DIRECT_ROWS = 30000 };

static sb_preconditioner **sbi_static_precond(sb_body *b)
{
    return b->elimination ? &b->elimination->precond : &b->precond;
}

SBI_API void sbi_static_take_direct(sbi_step *step)
{
    sb_body *b = step->body;
    const sb_matrix *matrix = b->elimination ? &b->elimination->matrix : &b->matrix;
    sb_preconditioner_def def = sb_default_preconditioner_def();
    sb_preconditioner *made = NULL, **place = sbi_static_precond(b);
    if (step->kept || step->touch || !b->auto_solver || matrix->row_count > SBI_DIRECT_ROWS)
        return;
    def.kind = SB_PRECOND_CHOLESKY;
    def.positions = b->reference;
    def.jobs = b->jobs;
    if (sb_preconditioner_create(&def, matrix, &b->allocator, &made, NULL) != SB_OK)
        return;
    step->kept = *place;
    *place = made;
}

SBI_API void sbi_static_give_back_direct(sbi_step *step)
{
    sb_preconditioner **place = sbi_static_precond(step->body);
    if (!step->kept)
        return;
    sb_preconditioner_free(*place);
    *place = step->kept;
    step->kept = NULL;
}
