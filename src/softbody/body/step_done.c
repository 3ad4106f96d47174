/* step_done: when an increment of a static solve is done: by forces, and by the energy of what is still missing,
 * neither measured by what clamps hold. */
#include <math.h>

#include "rigid_private.h"
#include "step_private.h"

/* Work (J) of the loads and of supports that move, since the solve began; not of forces that cancel each other. */
static double sbi_static_work_done(const sbi_step *step, int part)
{
    const sb_body *b = step->body;
    sbi_static_nodes nodes = sbi_static_part(b, part);
    double work = step->guests_begun ? sbi_rigids_work(step, part) : 0;
    for (int k = 0; k < nodes.count; k++) {
        int i = sbi_static_node(&nodes, k);
        unsigned held = sbi_body_held(b, i), fixed = b->fixed[i];
        sb_vec3 way = sbi_static_way(b, i), load = sb_v3_sub(b->internal[i], b->residual[i]);
        work +=
            fmax(sbi_static_work(SB_XYZ & ~fixed, load, way), sbi_static_work(SB_XYZ & ~held, b->equilibrated[i], way));
        work += sbi_static_work(fixed, b->residual[i], way);
    }
    return work;
}

/* Rounding (N): of the stresses, and of displacements themselves, half a digit of which moves a stiff row. */
SBI_API sb_real sbi_static_floor(const sbi_step *step)
{
    const sb_body *b = step->body;
    const sb_matrix *matrix = &b->matrix;
    double sum = 0;
    for (int i = 0; i < b->domain.node_count; i++) {
        const sb_real *d = matrix->blocks[matrix->diagonal[i]];
        unsigned axes = SB_XYZ & ~sbi_body_held(b, i);
        sb_vec3 u = b->displacement[i];
        double size = sbi_static_work(axes, sb_v3(d[0], d[4], d[8]), u);
        sum += size * size;
    }
    return sbi_step_rounding(step) + SB_EPSILON * (sb_real)sqrt(sum);
}

/* rhs = r on free axes, work = M^-1 r of the last system. */
static void sbi_static_precondition(sbi_step *step)
{
    sb_body *b = step->body;
    sb_preconditioner *precond = b->elimination ? b->elimination->precond : b->precond;
    const sb_vec3 *r = sbi_step_unbalanced(step), zero = sb_v3(0, 0, 0);
    for (int i = 0; i < b->domain.node_count; i++)
        b->rhs[i] = sbi_body_pick_axes(sbi_body_held(b, i), zero, r[i]);
    if (step->guests_begun)
        sbi_step_precondition_guests(step, precond, b->rhs, b->work);
    else
        sbi_precond_apply_symmetric(precond, &b->rhs[0].x, &b->work[0].x, (double)step->norm, &b->work2[0].x);
}

/* r.K^-1 r over the work done, of a part. */
static double sbi_static_part_energy(const sbi_step *step, int part)
{
    const sb_body *b = step->body;
    const double rounding = 16 * (double)SB_EPSILON, caution = 2; /* solves meet the smallest eigenvalue from above */
    sbi_static_nodes nodes = sbi_static_part(b, part);
    double sum = step->guests_begun ? sbi_step_guest_energy(step, part) : 0,
           least = rounding * rounding * (double)b->assembly.energy_unit;
    for (int k = 0; k < nodes.count; k++) {
        sb_vec3 r = b->rhs[sbi_static_node(&nodes, k)], z = b->work[sbi_static_node(&nodes, k)];
        sum += (double)r.x * (double)z.x + (double)r.y * (double)z.y + (double)r.z * (double)z.z;
    }
    return caution * fabs(sum) * fmax(1, b->pcg.record->softest) / fmax(sbi_static_work_done(step, part), least);
}

/* The report's energy and increment. */
static void sbi_static_measure(sbi_step *step)
{
    const sb_body *b = step->body;
    sb_static_report *report = &step->info->statics;
    int parts = sbi_step_parts(b)->part_count;
    double energy = 0, still = 0, gone = 0;
    if (!(step->norm > 0)) {
        report->energy = report->increment = 0;
        return;
    }
    sbi_static_precondition(step);
    for (int c = parts > 1 ? 0 : -1; c < (parts > 1 ? parts : 0); c++)
        energy = fmax(energy, sbi_static_part_energy(step, c));
    for (int i = 0; i < b->domain.node_count; i++) {
        still = fmax(still, sbi_static_largest(SB_XYZ, b->work[i]));
        gone = fmax(gone, sbi_static_largest(SB_XYZ, sbi_static_way(b, i)));
    }
    report->energy = (sb_real)energy;
    report->increment = (sb_real)(gone > 0 ? still / gone : 0);
}

SBI_API void sbi_static_begin_report(sbi_step *step)
{
    sb_static_report *report = &step->info->statics;
    report->reason = SB_STOP_NONE;
    report->force = report->floor = 0;
    report->energy = report->increment = -1;
    report->iterations = 0;
    step->least = (sb_real)INFINITY;
    step->stalls = step->rises = 0;
    step->expected = 0;
    step->body->assembly.came_from = NULL;
}

static int sbi_static_end(sbi_step *step, sb_stop_reason reason)
{
    step->info->statics.reason = reason;
    return 1;
}

/* Whether the energy of what is missing has stopped falling. A residual that is rounding says nothing of a linear body
 * whose system was solved, and of others only while that energy falls. */
static int sbi_static_has_stalled(sbi_step *step)
{
    sb_real energy = step->info->statics.energy;
    int rounded = step->norm <= sbi_step_rounding(step);
    step->stalls = energy < step->least / 2 ? 0 : step->stalls + 1;
    step->least = sb_min(step->least, energy);
    return rounded ? step->stalls > 0 || sbi_step_is_linear(step->body) : step->stalls > 1;
}

/* Tools that press have no share in the tangent that the last system's preconditioner was made of. */
static int sbi_static_is_measurable(const sbi_step *step) { return !step->touch && !step->forces_only; }

SBI_API int sbi_static_is_done(sbi_step *step)
{
    sb_static_report *report = &step->info->statics;
    const sb_real share = (sb_real)0.01;
    int meet = sbi_step_parts_meet(step, 0), balanced;
    report->force = step->info->residual;
    if (step->moves_supports)
        return 0;
    if (step->iteration == 0 || !sbi_static_is_measurable(step))
        return sbi_step_is_converged(step) ? sbi_static_end(step, meet ? SB_STOP_CONVERGED : SB_STOP_FLOOR) : 0;
    step->rounding = sbi_static_floor(step);
    report->floor = step->scale > 0 ? step->rounding / step->scale : 0;
    balanced = sbi_step_is_converged(step);
    if (!balanced && step->norm > 2 * step->rounding)
        return 0;
    sbi_static_measure(step);
    if (balanced && report->energy <= share * step->tolerance)
        return sbi_static_end(step, meet ? SB_STOP_CONVERGED : SB_STOP_FLOOR);
    return sbi_static_has_stalled(step) ? sbi_static_end(step, SB_STOP_FLOOR) : 0;
}

SBI_API int sbi_static_settles(sbi_step *step)
{
    int near = step->norm <= 2 * step->rounding ||
               (sbi_step_parts(step->body)->part_count == 1 && step->norm <= step->tolerance * step->held_scale);
    if (step->iteration == 0 || step->moves_supports || step->touch || !near)
        return 0;
    return sbi_static_end(step, SB_STOP_FLOOR);
}
