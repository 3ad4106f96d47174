/* step_touch: what touches a body takes part in its steps, see step_touch.h. */
#include "step_touch.h"

#include <string.h>

#include "cavity_law.h"
#include "rigid_private.h"
#include "step_private.h"

SBI_API void sbi_body_set_touch(sb_body *body, sbi_touch *touch)
{
    body->touch = touch;
    if (touch)
        return;
    sbi_free(&body->allocator, body->substep_room);
    body->substep_room = NULL;
    body->substep_room_size = 0;
}
SBI_API void sbi_body_set_touch_keeper(sb_body *body, const sbi_touch_keeper *keeper)
{
    const sbi_touch_keeper none = {NULL, NULL};
    body->touch_keeper = keeper ? *keeper : none;
}

SBI_API int sbi_body_reserve_touch_kept(const sb_body *body)
{
    return !body->touch_keeper.reserve || body->touch_keeper.reserve(body->touch_keeper.user);
}

SBI_API sbi_touch *sbi_body_get_touch(const sb_body *body) { return body->touch; }

SBI_API sb_result sbi_body_reserve_coupling(sb_body *body, int nodes, sb_error *error)
{
    int unknowns = 0;
    sbi_rigids_count(body, &unknowns, &nodes);
    return sbi_pcg_reserve_guest_room(&body->pcg, &body->matrix, body->matrix.row_count, unknowns, nodes, error);
}

/* ---- between the body's vectors and those of the nodes in touch ---- */

SBI_API const unsigned char *sbi_step_touch_mask(const sb_body *b) { return b->elimination ? NULL : b->fixed; }

/* Displacement that du counts from: that at the start of the step, or of the increment of a static solve. */
static const sb_vec3 *sbi_touch_start(const sbi_step *step)
{
    return step->dynamic ? step->body->start : step->body->converged;
}

/* du = the displacement at u + share increment since the start. */
static void sbi_touch_gather(const sbi_step *step, const sb_vec3 *u, const sb_vec3 *increment, sb_real share)
{
    const sbi_touch *touch = step->touch;
    const sb_vec3 *start = sbi_touch_start(step);
    for (int k = 0; k < touch->node_count; k++) {
        int node = touch->nodes[k];
        sb_vec3 d = sb_v3_sub(u[node], start[node]);
        touch->du[k] = increment ? sb_v3_madd(d, share, increment[node]) : d;
    }
}

/* ---- begin ---- */

/* The coupling becomes one more guest of the step. */
static sb_result sbi_step_couple_touch(sbi_step *step)
{
    sb_body *b = step->body;
    sbi_touch *touch = step->touch;
    int count = step->given.count;
    touch->couples = touch->coupling.node_count > 0 && !b->elimination;
    if (!touch->couples && step->guests.count == count)
        return SB_OK;
    if (count >= SBI_STEP_MOST_GUESTS)
        return sbi_fail(&step->info->error, SB_ERROR_UNSUPPORTED, "a step with tools on springs has at most %d needles",
                        SBI_STEP_MOST_GUESTS - 1);
    for (int g = 0; g < count; g++)
        b->step_guests[g] = step->given.list[g];
    if (touch->couples)
        b->step_guests[count++] = &touch->coupling;
    step->guests_begun = 0;
    step->guests.count = 0;
    return sbi_step_take_guests(step, b->step_guests, count);
}

SBI_API sb_real sbi_body_diagonal_mass(const sb_body *b, int node)
{
    return b->mass_blocks ? b->mass_blocks[b->matrix.diagonal[node]] : b->lumped_mass[node];
}

/* Accelerations go with 1 / dt^2, velocities with 1 / dt. */
static void sbi_touch_tell_whole(const sbi_step *step, sbi_touch_step *told)
{
    const sb_body *b = step->body;
    sb_real share = step->touch->share, mass = step->ca + b->damping_mass * step->cv;
    told->whole_stiff = 1;
    if (!step->touch->steady || !step->dynamic)
        return;
    told->whole_stiff = (1 + b->damping_stiffness * step->cv * share) / (1 + b->damping_stiffness * step->cv);
    told->whole_mass = share * (step->ca * share + b->damping_mass * step->cv) - told->whole_stiff * mass;
}

SBI_API sb_result sbi_step_begin_touch(sbi_step *step)
{
    const sb_body *b = step->body;
    sbi_touch_step told;
    sb_result result;
    memset(&told, 0, sizeof told);
    told.matrix = &b->matrix;
    told.start = sbi_touch_start(step);
    told.velocity = b->velocity;
    told.dt = step->dynamic ? step->dt : 0;
    told.level = step->dynamic ? step->level : 1;
    told.factor = step->dynamic ? 1 : step->load_factor;
    told.stage = step->dynamic ? 0 : step->info->load_steps;
    told.tries = step->tries;
    told.linearised = step->linearised;
    told.wide = step->wide;
    told.part = step->dynamic ? step->part : 1;
    sbi_touch_tell_whole(step, &told);
    step->touch_begun = 1;
    step->touch->iterations = step->touch->capped = 0;
    step->touch->residual = 0;
    step->touch->coupling.node_count = 0;
    step->touch->apart = step->touch->parts = step->touch->missed = step->touch->foresees = 0;
    result = step->touch->begin(step->touch->user, &told, &step->info->error);
    step->touch->refused |= step->touch->apart;
    if (result == SB_OK)
        result = sbi_step_couple_touch(step);
    if (result != SB_OK && step->info->error.result != result)
        return sbi_fail(&step->info->error, result, "contact cannot begin a step");
    return result;
}

SBI_API void sbi_step_evaluate_touch(sbi_step *step, const sb_vec3 *increment, sb_real share, int renew)
{
    sbi_touch_gather(step, step->body->displacement, increment, share);
    step->touch->evaluate(step->touch->user, step->touch->du, renew);
}

SBI_API sb_real sbi_step_touch_work(const sbi_step *step, const sb_vec3 *increment)
{
    const sbi_touch *touch = step->touch;
    sb_real sum = 0;
    for (int k = 0; k < touch->node_count; k++)
        sum += sb_v3_dot(touch->force[k], increment[touch->nodes[k]]);
    return sum;
}

SBI_API void sbi_step_add_touch_force(const sbi_step *step, sb_real factor, sb_vec3 *out)
{
    const sbi_touch *touch = step->touch;
    for (int k = 0; k < touch->node_count; k++)
        out[touch->nodes[k]] = sb_v3_madd(out[touch->nodes[k]], factor, touch->force[k]);
}

/* ---- the system ---- */

SBI_API void sbi_step_add_touch(sbi_step *step)
{
    sb_body *b = step->body;
    sbi_touch *touch = step->touch;
    touch->add_blocks(touch->user, sbi_step_touch_mask(b), &b->matrix);
    if (!step->linearised)
        return;
    touch->multiply(touch->user, sbi_step_touch_mask(b), touch->du, touch->linear);
    for (int k = 0; k < touch->node_count; k++) {
        int node = touch->nodes[k];
        touch->linear[k] = sb_v3_add(touch->linear[k], touch->force[k]);
        if (!b->elimination)
            touch->linear[k] = sbi_body_pick_axes(b->fixed[node], sb_v3(0, 0, 0), touch->linear[k]);
        touch->kept[k] = b->rhs[node];
        b->rhs[node] = sb_v3_add(b->rhs[node], touch->linear[k]);
    }
}

/* Of a body with constraints T^T C T. */
static double sbi_touch_multiply_condensed(sb_body *b, const sb_real *x, sb_vec3 *y)
{
    const sbi_touch *touch = b->touch;
    double sum;
    memcpy(touch->whole, x, (size_t)b->domain.node_count * sizeof(sb_vec3));
    memset(touch->product, 0, (size_t)b->domain.node_count * sizeof(sb_vec3));
    for (int i = 0; i < b->domain.node_count; i++)
        touch->whole[i] = sbi_body_pick_axes(sbi_body_held(b, i), sb_v3(0, 0, 0), touch->whole[i]);
    sbi_elimination_expand(b->elimination, touch->whole, 0);
    sum = touch->multiply_links(touch->user, NULL, touch->whole, touch->product);
    sbi_elimination_reduce(b->elimination, touch->product, touch->product, NULL);
    for (int i = 0; i < b->domain.node_count; i++)
        y[i] = sb_v3_add(y[i], sbi_body_pick_axes(sbi_body_held(b, i), sb_v3(0, 0, 0), touch->product[i]));
    return sum;
}

/* The same of what touches. */
static double sbi_touch_multiply_links(sb_body *b, const sb_real *x, sb_real *y)
{
    if (b->elimination)
        return sbi_touch_multiply_condensed(b, x, (sb_vec3 *)(void *)y);
    return b->touch->multiply_links(b->touch->user, b->fixed, (const sb_vec3 *)(const void *)x, (sb_vec3 *)(void *)y);
}

SBI_API double sbi_body_multiply_links(void *body, const sb_real *x, sb_real *y)
{
    sb_body *b = (sb_body *)body;
    double sum = sbi_cavities_multiply(b, (const sb_vec3 *)(const void *)x, 1, (sb_vec3 *)(void *)y);
    return b->touch && b->touch->links ? sum + sbi_touch_multiply_links(b, x, y) : sum;
}

SBI_API int sbi_body_has_links(const sb_body *b) { return (b->touch && b->touch->links) || sbi_cavities_resist(b); }

SBI_API void sbi_body_lend_touch(sb_body *b, sbi_pcg_extra *extra)
{
    extra->user = b;
    extra->multiply = sbi_body_multiply_links;
    b->pcg.extra = sbi_body_has_links(b) ? extra : NULL;
}

/* ---- end ---- */

SBI_API void sbi_step_touch_reactions(const sbi_step *step)
{
    sb_body *b = step->body;
    const sbi_touch *touch = step->touch;
    for (int k = 0; k < touch->node_count; k++) {
        int node = touch->nodes[k];
        b->reaction[node] =
            sbi_body_pick_axes(b->fixed[node], sb_v3_sub(b->reaction[node], touch->force[k]), b->reaction[node]);
    }
}

SBI_API int sbi_step_balance_touch(sbi_step *step, int round) { return step->touch->balance(step->touch->user, round); }

SBI_API void sbi_step_commit_touch(sbi_step *step)
{
    step->touch_begun = 0;
    step->touch->commit(step->touch->user);
}

SBI_API void sbi_step_undo_touch(sbi_step *step)
{
    if (step->touch_begun)
        step->touch->undo(step->touch->user);
    step->touch_begun = 0;
}

/* ---- between steps ---- */

SBI_API sb_result sbi_body_solve_column(sb_body *b, sb_vec3 *rhs, sb_vec3 *x, sb_real tolerance)
{
    sbi_elimination *e = b->elimination;
    sb_pcg_options options = sb_default_pcg_options();
    sbi_pcg_extra extra;
    sb_result result;
    options.tolerance = (double)tolerance;
    options.max_iterations = b->max_iterations;
    options.jobs = &b->jobs;
    if (e)
        sbi_elimination_reduce(e, rhs, rhs, NULL);
    for (int i = 0; i < b->domain.node_count; i++) {
        x[i] = sb_v3(0, 0, 0);
        rhs[i] = sbi_body_pick_axes(sbi_body_held(b, i), x[i], rhs[i]);
    }
    sbi_body_lend_touch(b, &extra);
    result = sb_pcg_solve(e ? &e->matrix : &b->matrix, e ? e->precond : b->precond, &rhs[0].x, &x[0].x, &options,
                          &b->pcg, NULL);
    b->pcg.extra = NULL;
    if (e)
        sbi_elimination_expand(e, x, 0);
    return result == SB_ERROR_NOT_CONVERGED ? SB_OK : result;
}
