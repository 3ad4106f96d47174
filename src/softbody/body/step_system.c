/* step_system: the linear system of one Newton iteration: supports, constraints, preconditioner, solution,
 * reactions. */
#include <string.h>

#include "cavity_law.h"
#include "constraint.h"
#include "rigid_private.h"
#include "step_private.h"

enum { SBI_STATIC_SLOW = 1000 }; /* iterations of conjugate gradients */

/* A share of node i's way to the target of its supports; exact at its end. */
static sb_vec3 sbi_step_go(const sb_body *b, int i, sb_real share, sb_vec3 target)
{
    return share == 1 ? target : sb_v3_madd(b->start[i], share, sb_v3_sub(target, b->start[i]));
}

SBI_API sb_vec3 sbi_step_target(const sbi_step *step, int i)
{
    return sbi_step_go(step->body, i, step->part, step->body->target[i]);
}

SBI_API sb_vec3 sbi_step_goal(const sbi_step *step, int i)
{
    return sbi_step_go(step->body, i, step->load_factor, sbi_step_target(step, i));
}

/* What supported axes of node i still have to go. */
static sb_vec3 sbi_step_way_to_go(const sbi_step *step, int i)
{
    const sb_body *b = step->body;
    return sbi_body_pick_axes(b->fixed[i], sb_v3_sub(sbi_step_goal(step, i), b->displacement[i]), sb_v3(0, 0, 0));
}

SBI_API int sbi_step_supports_move(const sbi_step *step)
{
    const sb_body *b = step->body;
    if (b->elimination && sbi_elimination_open(b->elimination, b->displacement, step->load_factor))
        return 1;
    for (int i = 0; i < b->domain.node_count; i++)
        if (b->fixed[i]) {
            sb_vec3 go = sbi_step_way_to_go(step, i);
            if (go.x != 0 || go.y != 0 || go.z != 0)
                return 1;
        }
    return 0;
}

SBI_API sb_vec3 sbi_step_coast(const sbi_step *step, int i)
{
    const sb_body *b = step->body;
    sb_vec3 coast = sb_v3_scale(step->level * step->dt, b->velocity[i]);
    return b->fixed[i] ? sbi_body_pick_axes(b->fixed[i], sb_v3(0, 0, 0), coast) : coast;
}

/* Start of the linear solve: what the motion predicts on free axes, the way still to go on supported ones. */
static void sbi_step_predict(sbi_step *step)
{
    sb_body *b = step->body;
    int coasts = step->iteration == 0 && step->dynamic;
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 coast = coasts ? sbi_step_coast(step, i) : sb_v3(0, 0, 0);
        b->increment[i] = b->fixed[i] ? sbi_body_pick_axes(b->fixed[i], sbi_step_way_to_go(step, i), coast) : coast;
    }
}

/* Keeps the rows of supported nodes, which the reactions need, before they are masked. */
static void sbi_step_keep_support_rows(sb_body *b)
{
    const sb_matrix *matrix = &b->matrix;
    sb_real(*out)[9] = b->support_blocks;
    for (int i = 0; i < matrix->row_count; i++)
        if (b->fixed[i] && b->node_component[i] >= 0) {
            int count = matrix->row_end[i] - matrix->row_start[i];
            memcpy(out, matrix->blocks + matrix->row_start[i], (size_t)count * sizeof *out);
            out += count;
        }
}

SBI_API void sbi_step_mask(sb_body *b, sb_vec3 *x, sb_vec3 *rhs)
{
    sbi_step_keep_support_rows(b);
    sbi_matrix_constrain(&b->matrix, b->fixed, &x[0].x, &rhs[0].x, &b->jobs);
}

/* Reactions of a constrained body, whose matrix has not been masked: r, or r + A du, condensed. */
static void sbi_step_constrained_reactions(const sbi_step *step)
{
    sb_body *b = step->body;
    memcpy(b->work, b->residual, (size_t)b->domain.node_count * sizeof(sb_vec3));
    if (step->linearised) {
        sb_matrix_multiply(&b->matrix, &b->increment[0].x, &b->work2[0].x, &b->jobs);
        (void)sbi_cavities_multiply(b, b->increment, 0, b->work2);
        for (int i = 0; i < b->domain.node_count; i++)
            b->work[i] = sb_v3_add(b->work[i], b->work2[i]);
    }
    sbi_constraint_reactions(b, b->work);
}

/* What the pressure of cavities has changed by in a linearised step. */
static void sbi_step_cavity_reactions(const sbi_step *step)
{
    sb_body *b = step->body;
    memset(b->work, 0, (size_t)b->domain.node_count * sizeof(sb_vec3));
    (void)sbi_cavities_multiply(b, b->increment, 0, b->work);
    for (int i = 0; i < b->domain.node_count; i++)
        b->reaction[i] = sbi_body_pick_axes(b->node_component[i] < 0 ? 0 : b->fixed[i],
                                            sb_v3_add(b->reaction[i], b->work[i]), b->reaction[i]);
}

/* The same of a body without constraints. */
static void sbi_step_support_reactions(const sbi_step *step)
{
    sb_body *b = step->body;
    const sb_matrix *matrix = &b->matrix;
    const sb_real(*row)[9] = (const sb_real(*)[9])b->support_blocks;
    const sb_vec3 zero = sb_v3(0, 0, 0);
    for (int i = 0; i < matrix->row_count; i++) {
        sb_vec3 sum = b->residual[i];
        b->reaction[i] = zero;
        if (!b->fixed[i] || b->node_component[i] < 0)
            continue;
        for (int k = matrix->row_start[i]; step->linearised && k < matrix->row_end[i]; k++, row++)
            sum = sb_v3_add(sum, sbi_step_block_product(*row, b->increment[matrix->columns[k]]));
        b->reaction[i] = sbi_body_pick_axes(b->fixed[i], sum, zero);
    }
}

SBI_API void sbi_step_reactions(const sbi_step *step)
{
    if (step->unassembled)
        sbi_unassembled_reactions(step);
    else if (step->body->elimination)
        sbi_step_constrained_reactions(step);
    else
        sbi_step_support_reactions(step);
    if (!step->body->elimination && step->linearised && sbi_cavities_resist(step->body))
        sbi_step_cavity_reactions(step);
    sbi_step_guest_reactions(step);
    if (step->touch && step->linearised)
        sbi_step_touch_reactions(step);
    sbi_rigids_read(step);
}

SBI_API int sbi_step_is_linear(const sb_body *b)
{
    for (int i = 0; i < b->material_count; i++)
        if (!sb_material_is_linear(b->materials[i].model))
            return 0;
    return 1;
}

/* Tolerance of this iteration's linear solve. A linearised step has its own; otherwise it tightens with Newton's
 * progress (Eisenstat and Walker 1996, choice 2), never beyond what the residual's tolerance can notice. */
SBI_API sb_real sbi_step_linear_tolerance(const sbi_step *step)
{
    const sb_body *b = step->body;
    sb_real least = 10 * SB_EPSILON, enough = least, forcing = (sb_real)1e-2;
    if (step->linear_tolerance > 0)
        return step->linear_tolerance;
    if (step->norm > 0)
        enough = (sb_real)0.1 * step->tolerance * step->scale / step->norm;
    if (sbi_step_is_linear(b))
        return sb_max(sb_min((sb_real)0.1 * step->tolerance, enough), least);
    if (step->iteration > 0 && step->last_norm > 0) {
        sb_real ratio = step->norm / step->last_norm;
        forcing = sb_min(forcing, (sb_real)0.5 * ratio * ratio);
    }
    return sb_max(sb_max(forcing, sb_min(enough, (sb_real)1e-2)), least);
}

/* T^T A T du' = T^T (-r - A g) in place of A du = -r, g being the jump that closes the constraints' gaps while their
 * masters rest. Returns 1 when there is one. */
static int sbi_step_condense(sbi_step *step)
{
    sb_body *b = step->body;
    sbi_elimination *e = b->elimination;
    int n = b->domain.node_count, open = sbi_elimination_open(e, b->displacement, step->load_factor);
    if (open) {
        memset(b->work, 0, (size_t)n * sizeof(sb_vec3));
        sbi_elimination_expand(e, b->work, 1);
        sb_matrix_multiply(&b->matrix, &b->work[0].x, &b->work2[0].x, &b->jobs);
        if (step->touch && step->touch->links)
            (void)step->touch->multiply_links(step->touch->user, NULL, b->work, b->work2);
        (void)sbi_cavities_multiply(b, b->work, 0, b->work2);
        for (int i = 0; i < n; i++)
            b->rhs[i] = sb_v3_sub(b->rhs[i], b->work2[i]);
    }
    sbi_elimination_reduce(e, b->rhs, b->rhs, NULL);
    sbi_elimination_clear_slaves(e, b->increment);
    sbi_elimination_condense(e, &b->matrix);
    for (int i = 0; i < n; i++)
        e->held[i] = (unsigned char)sbi_body_held(b, i);
    return open;
}

SBI_API void sbi_step_fill_system(sbi_step *step)
{
    sb_body *b = step->body;
    sbi_elimination *e = b->elimination;
    step->opens_gaps = 0;
    for (int i = 0; i < b->domain.node_count; i++)
        b->rhs[i] = sb_v3_scale(-1, b->residual[i]);
    if (e && step->touch)
        sbi_step_add_touch(step);
    if (e) {
        step->opens_gaps = sbi_step_condense(step);
        sbi_matrix_constrain(&e->matrix, e->held, &b->increment[0].x, &b->rhs[0].x, &b->jobs);
    } else {
        sbi_step_mask(b, b->increment, b->rhs);
    }
    if (!e && step->touch)
        sbi_step_add_touch(step);
}

/* The preconditioner of a system that is made. */
static sb_result sbi_step_make_precond(sbi_step *step, sb_matrix *matrix)
{
    sb_body *b = step->body;
    sb_preconditioner *precond;
    sbi_precond_memory before;
    sb_result result = sbi_body_settle_preconditioner(b, &step->info->error);
    if (result != SB_OK)
        return result;
    precond = b->elimination ? b->elimination->precond : b->precond;
    before = sbi_precond_get_memory(precond);
    result = sbi_body_update_precond(b, precond, matrix, &step->guests, &step->info->error);
    if (result == SB_OK && step->notes)
        sbi_kept_note(b, before);
    return result;
}

/* The same of a tangent that was kept: all is there but the right-hand side. */
static sb_result sbi_step_make_kept_system(sbi_step *step)
{
    sb_body *b = step->body;
    sbi_step_predict(step);
    step->opens_gaps = 0;
    for (int i = 0; i < b->domain.node_count; i++) { /* supports rest */
        sb_vec3 force = sb_v3_scale(-1, b->residual[i]);
        b->rhs[i] = b->fixed[i] ? sbi_body_pick_axes(b->fixed[i], sb_v3(0, 0, 0), force) : force;
    }
    return sbi_step_begin_guests(step, &b->matrix);
}

SBI_API sb_result sbi_step_make_system(sbi_step *step)
{
    sb_body *b = step->body;
    sb_matrix *matrix = b->elimination ? &b->elimination->matrix : &b->matrix;
    sb_result result;
    double begin = sbi_body_now(b);
    if (step->keeps)
        return sbi_step_make_kept_system(step);
    if (step->slow)
        sbi_static_take_direct(step);
    sbi_step_predict(step);
    if (step->unassembled) {
        sbi_unassembled_fill(step);
        return SB_OK;
    }
    if (step->touch && step->linearised)
        sbi_step_evaluate_touch(step, b->increment, 1, 1);
    sbi_step_fill_system(step);
    result = sbi_step_begin_guests(step, matrix);
    if (result == SB_OK)
        result = sbi_step_make_precond(step, matrix);
    step->info->seconds_precond += sbi_body_now(b) - begin;
    return result;
}

/* How a linearised step bends away from coasting: as the step before did. */
static const sb_real *sbi_step_bend(const sbi_step *step)
{
    const sb_body *b = step->body;
    return step->linearised && b->acceleration_known ? &b->acceleration[0].x : NULL;
}

SBI_API sb_result sbi_step_solve_once(sbi_step *step, sb_real tolerance, const sbi_pcg_demand *demand)
{
    sb_body *b = step->body;
    sb_step_info *info = step->info;
    sb_pcg_options options = sb_default_pcg_options();
    sb_pcg_info pcg = {0, 0, 0, 0, 0};
    sbi_elimination *e = b->elimination;
    sbi_pcg_demand asked = demand ? *demand : sbi_pcg_step_demand();
    sbi_pcg_extra extra;
    sbi_pcg_operator whole;
    sb_result result;
    asked.bend = asked.later ? NULL : sbi_step_bend(step);
    asked.product = step->keeps ? &b->work2[0].x : NULL; /* see sbi_kept_add_coasting */
    b->pcg.extra = NULL;
    if (!step->starts && (step->touch || b->load_count))
        sbi_body_lend_touch(b, &extra);
    options.tolerance = (double)tolerance;
    options.max_iterations = step->max_iterations;
    options.jobs = &b->jobs;
    b->pcg.unassembled = step->unassembled ? sbi_unassembled_operator(step, &whole) : NULL;
    result = sbi_pcg_solve_guests(e ? &e->matrix : &b->matrix, e ? e->precond : b->precond, &b->rhs[0].x,
                                  &b->increment[0].x, &step->guests, &options, &b->pcg, &asked, &pcg);
    b->pcg.extra = NULL;
    b->pcg.unassembled = NULL;
    info->pcg_iterations += pcg.iterations;
    step->slow = !step->dynamic && !step->starts && pcg.iterations > SBI_STATIC_SLOW;
    if (step->linearised)
        info->residual = (sb_real)pcg.residual;
    if (result == SB_ERROR_NOT_CONVERGED) { /* still the best increment so far: use it */
        info->capped |= pcg.capped;
        result = SB_OK;
    }
    if (e)
        sbi_elimination_expand(e, b->increment, step->opens_gaps);
    return result;
}
