/* step_guess: see step_guess.h. */
#include "step_guess.h"

#include <math.h>
#include <string.h>

#include "constraint.h"
#include "load.h"
#include "step_private.h"

static const sb_real sbi_guess_duration = (sb_real)INFINITY; /* all has relaxed that relaxes */

/* A static solve that looks at u: what it changes of the body sbi_step_restore gives back. */
static sb_result sbi_guess_begin(sbi_step *step, sb_body *b, sb_step_info *info, const sb_vec3 *u)
{
    memset(step, 0, sizeof *step);
    sbi_step_begin_info(info);
    step->body = b;
    step->info = info;
    step->part = step->load_factor = step->loads_factor = 1;
    step->tolerance = (sb_real)1e-6;
    step->max_iterations = sb_default_static_options().max_iterations;
    step->line_search = 1;
    sbi_step_save(b);
    sbi_step_watch_folds(b, 0);
    sbi_step_enter(b, sbi_guess_duration);
    memcpy(b->converged, b->displacement, (size_t)b->domain.node_count * sizeof(sb_vec3));
    sbi_loads_begin_static(b);
    sbi_static_loads(b, 1);
    memcpy(b->displacement, u, (size_t)b->domain.node_count * sizeof(sb_vec3));
    b->force_current = 0;
    return sbi_step_evaluate(step);
}

/* Potential at u above that at `from`; -INFINITY where that is inadmissible. */
static sb_real sbi_guess_change(sb_body *b, const sb_vec3 *from, const sb_vec3 *u)
{
    sbi_step step;
    sb_step_info info;
    sb_real change = -(sb_real)INFINITY;
    sb_result result = sbi_guess_begin(&step, b, &info, from);
    for (int i = 0; i < b->domain.node_count; i++)
        b->increment[i] = sb_v3_sub(u[i], from[i]);
    if (result == SB_OK)
        change = sbi_step_change(&step);
    sbi_step_restore(b);
    return change;
}

SBI_API void sbi_guess_settle(const sb_body *b, sb_vec3 *u)
{
    for (int i = 0; i < b->domain.node_count; i++)
        if (b->fixed[i])
            u[i] = sbi_body_pick_axes(b->fixed[i], b->target[i], u[i]);
    if (b->elimination)
        sbi_elimination_follow(b->elimination, u, 1);
}

SBI_API sb_result sbi_guess_weigh(sb_body *b, const sb_vec3 *u, sb_vec3 *scratch, sbi_guess *guess, sb_error *error)
{
    size_t bytes = (size_t)b->domain.node_count * sizeof *scratch;
    sbi_step step;
    sb_step_info info;
    sb_result result = sbi_guess_begin(&step, b, &info, u);
    if (result == SB_OK) {
        guess->force = step.norm;
        (void)sbi_step_parts_meet(&step, 0);
        guess->residual = info.residual;
    }
    sbi_step_restore(b);
    if (result != SB_OK) {
        if (error)
            *error = info.error;
        return result;
    }
    memset(scratch, 0, bytes);
    sbi_guess_settle(b, scratch);
    guess->from_rest = sbi_guess_change(b, scratch, u);
    memcpy(scratch, b->displacement, bytes);
    sbi_guess_settle(b, scratch);
    guess->from_last = sbi_guess_change(b, scratch, u);
    return SB_OK;
}

SBI_API sb_result sbi_guess_smooth(sb_body *b, sb_vec3 *u, sb_error *error)
{
    size_t bytes = (size_t)b->domain.node_count * sizeof *u;
    sbi_step step;
    sb_step_info info;
    sb_result result;
    sbi_start_use_twins(b, sbi_guess_duration);
    result = sbi_guess_begin(&step, b, &info, u);
    if (result == SB_OK)
        result = sbi_start_hold(&step);
    for (int i = 0; result == SB_OK && i < b->domain.node_count; i++)
        if (!sb_v3_is_finite(b->work2[i]))
            result = sbi_fail(&info.error, SB_ERROR_DIVERGED, "the shape with its rotations held is not finite");
    if (result == SB_OK)
        memcpy(u, b->work2, bytes);
    sbi_start_use_own(b, sbi_guess_duration);
    sbi_step_restore(b);
    result = sbi_step_report(&info, result);
    if (result != SB_OK && error)
        *error = info.error;
    return result;
}
