/* step_explicit_touch: contact in explicit steps. Each substep is a step of contact: what is near is found where the
 * body is, and pushes where it has gone to, beside the loads. Its stiffness is bounded by the nodes' masses: with
 * `rate` lambda_c = c lambda, lambda the square of the body's highest frequency, substeps that are shorter by sqrt(1 +
 * c) are as stable as those without contact: no eigenvalue of a sum is more than the largest of both together. */
#include <string.h>

#include "step_explicit.h"
#include "step_touch.h"

static sbi_touch_step sbi_explicit_tell_touch(const sb_body *b, sb_real left, double count, int tries)
{
    const sb_real stable = b->guard.stable_step;
    sbi_touch_step told;
    memset(&told, 0, sizeof told);
    told.start = b->displacement;
    told.velocity = b->velocity;
    told.dt = (sb_real)((double)left / count);
    told.level = told.factor = 1;
    told.tries = tries;
    told.part = (sb_real)(1 / count);
    told.masses = b->lumped_mass;
    told.rate = b->touch->stiffening * 4 / (stable * stable);
    return told;
}

/* Longest substep h (s) where something is near: stable, and with lambda_c h^2 <= 1. What comes into touch within a
 * substep does so at its end, with up to lambda_c h^2 / 2 of its energy too much or too little. */
static sb_real sbi_explicit_near(const sb_body *b, sb_real longest)
{
    const sb_real c = b->touch->stiffening;
    return sb_min(longest / sb_sqrt(1 + c), b->guard.stable_step / (2 * sb_sqrt(c)));
}

SBI_API sb_result sbi_explicit_begin_touch(sb_body *b, sb_real left, sb_real longest, int tries, double *count,
                                           sb_error *error)
{
    sbi_touch *touch = b->touch;
    sb_result result = SB_OK;
    sbi_body_update_positions(b);
    for (int near = 0; near < 2; near++) {
        sbi_touch_step told;
        *count = sbi_explicit_count(left, near ? sbi_explicit_near(b, longest) : longest);
        told = sbi_explicit_tell_touch(b, left, *count, tries);
        touch->iterations = touch->capped = 0;
        touch->residual = 0;
        touch->coupling.node_count = 0;
        result = touch->begin(touch->user, &told, error);
        if (result != SB_OK && error->result != result)
            return sbi_fail(error, result, "contact cannot begin a step");
        if (result != SB_OK || near || touch->node_count == 0)
            break;
        touch->undo(touch->user);
    }
    return result;
}

SBI_API sb_result sbi_explicit_meet_touch(sb_body *b, sb_error *error)
{
    sbi_touch *touch = b->touch;
    for (int k = 0; k < touch->node_count; k++)
        touch->du[k] = b->increment[touch->nodes[k]];
    touch->evaluate(touch->user, touch->du, 1);
    touch->refused = !touch->accept(touch->user, b->displacement);
    if (touch->refused)
        return sbi_fail(error, SB_ERROR_DIVERGED,
                        "the body moves so far in a substep that a tool may have passed through it");
    return SB_OK;
}

SBI_API void sbi_explicit_add_touch(sb_body *b, int met)
{
    const sbi_touch *touch = b->touch;
    if (!met)
        touch->add_done(touch->user, 1, b->follower);
    for (int k = 0; met && k < touch->node_count; k++)
        b->follower[touch->nodes[k]] = sb_v3_add(b->follower[touch->nodes[k]], touch->force[k]);
}

SBI_API double sbi_explicit_touch_swing(const sb_body *b, sb_real h)
{
    const sbi_touch *touch = b->touch;
    double sum = 0;
    for (int k = 0; k < touch->node_count; k++) {
        double mass = (double)b->lumped_mass[touch->nodes[k]];
        sum += mass > 0 ? (double)sb_v3_dot(touch->force[k], touch->force[k]) / mass : 0;
    }
    return (double)h * (double)h / 8 * sum;
}

SBI_API void sbi_explicit_commit_touch(sb_body *b) { b->touch->commit(b->touch->user); }
