/* step_kept: linearised steps that go on with the tangent and the preconditioner of a step before.
 *
 * A' stands for A: it has the same factors, but the rotations of an earlier shape. It multiplies only what the
 * increment x differs by from the way x0 that the nodes coast, A' (x - x0) = -r - A x0, so that x is off by A^-1 (A' -
 * A) (x - x0): by the angle that elements have turned since, of what the motion changes by within the step. A x0 and
 * the damping force need no matrix, and the elements add them to their forces: sbi_assembly_force_along. What is solved
 * is written as A' x = -(r + (A - A') x0), where all that follows (guests, reactions) finds the system that it knows.
 *
 * That angle counts by what it does: to a mode that A' has next to no stiffness for, as of nearly incompressible or
 * slender bodies in long steps, A may give many times that, and steps of more than 4/3 of their share feed energy in.
 * So the work of both along x - x0 is compared once it is known; where they differ too much, the step is solved anew
 * with a tangent of its own: see sbi_kept_was_near. Where x0 meets the tolerance, x is x0 and A' has had no say.
 *
 * Others may have used the matrix meanwhile: what A' was made of is kept, and gives the same bits again. It has two
 * places; the next one is made in the other, so that a step that fails gives the one before back. */
#include <math.h>
#include <string.h>

#include "../solve/sparse_live.h"
#include "step_private.h"

/* ---- whether it serves ---- */

static int sbi_kept_has_taken_nodes(const sbi_guests *guests)
{
    for (int g = 0; g < guests->count; g++)
        if (guests->list[g]->taken_count > 0)
            return 1;
    return 0;
}

/* 1: all of A is a matter of the rotations and of two factors, and all of the preconditioner one of A and positions. */
static int sbi_kept_may(const sbi_step *step)
{
    const sb_body *b = step->body;
    const sbi_assembly *assembly = &b->assembly;
    return b->kept && b->kept->angle > 0 && step->dynamic && step->linearised && !step->moves_supports &&
           assembly->batched && assembly->batch_quats && !b->elimination && b->load_count == 0 && !step->touch &&
           !step->pushed && !b->regional_damping && !(assembly->rows && assembly->rows->count) &&
           !(assembly->glue && assembly->glue->count) && !sbi_kept_has_taken_nodes(&step->guests) &&
           sb_preconditioner_get_info(b->precond).kind != SB_PRECOND_MULTIGRID;
}

/* Largest square of the distance between the quaternions of a batch and those that were kept, which is half the angle
 * between the rotations. */
static sb_real sbi_kept_distance(const sb_real *now, const sb_real *then, int count)
{
    sb_real square[SB_POLAR_LANES], largest = 0;
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_real w = now[l] - then[l], x = now[SB_POLAR_LANES + l] - then[SB_POLAR_LANES + l];
        sb_real y = now[2 * SB_POLAR_LANES + l] - then[2 * SB_POLAR_LANES + l];
        sb_real z = now[3 * SB_POLAR_LANES + l] - then[3 * SB_POLAR_LANES + l];
        square[l] = w * w + x * x + y * y + z * z;
    }
    for (int l = 0; l < count; l++)
        largest = sb_max(largest, square[l]);
    return largest;
}

static int sbi_kept_has_turned(const sb_body *b)
{
    const sbi_kept *kept = b->kept;
    const sb_real *now = b->assembly.batch_quats, *then = kept->rotations[kept->made.slot];
    sb_real most = kept->angle * kept->angle / 4;
    int cells = b->domain.cell_count;
    for (int e = 0; e < cells; e += SB_POLAR_LANES, now += 4 * SB_POLAR_LANES, then += 4 * SB_POLAR_LANES)
        if (!(sbi_kept_distance(now, then, sbi_min_int(SB_POLAR_LANES, cells - e)) <= most))
            return 1;
    return 0;
}

static int sbi_kept_fits_factors(const sb_body *b)
{
    const sbi_kept *kept = b->kept;
    return sbi_kept_is_valid(b) && kept->made.mass == kept->mass && kept->made.stiffness == kept->stiffness;
}

/* ---- forces ---- */

SBI_API void sbi_kept_give_up(sbi_step *step)
{
    sb_body *b = step->body;
    step->keeps = 0;
    step->notes = 1;
    sbi_assembly_force_along(&b->assembly, b->displacement, NULL, 1, b->internal);
    b->force_current = 1;
}

SBI_API int sbi_kept_force(sbi_step *step)
{
    sb_body *b = step->body;
    double begin = sbi_body_now(b);
    sb_real damping, stiffness;
    step->keeps = step->notes = 0;
    if (!sbi_kept_may(step))
        return 0;
    b->kept->mass = sbi_step_mass_factor(step);
    b->kept->stiffness = stiffness = sbi_step_stiffness_factor(step);
    step->keeps = sbi_kept_fits_factors(b);
    step->notes = !step->keeps;
    if (!step->keeps)
        return 0;
    damping = sbi_body_has_beta(b) && step->has_velocity ? sbi_step_beta(b) : 0;
    for (int i = 0; i < b->domain.node_count; i++)
        b->work[i] = sb_v3_madd(sb_v3_scale(damping, sbi_step_velocity(step, i)), stiffness, sbi_step_coast(step, i));
    sbi_assembly_force_along(&b->assembly, b->displacement, b->work, b->force_current, b->internal);
    b->force_current = 0;
    if (sbi_kept_has_turned(b))
        sbi_kept_give_up(step);
    step->info->seconds_force += sbi_body_now(b) - begin;
    return 1;
}

/* ---- of a step ---- */

/* The body's matrix, support rows and preconditioner as they were when what is kept was noted. */
static sb_result sbi_kept_make(sbi_step *step)
{
    sb_body *b = step->body;
    const sbi_kept *kept = b->kept;
    sbi_precond_memory memory = sbi_precond_get_memory(b->precond);
    sb_real *rotations = b->assembly.batch_quats;
    size_t bytes = (size_t)b->domain.node_count * sizeof(sb_vec3);
    sb_result result;
    b->assembly.batch_quats = kept->rotations[kept->made.slot];
    sbi_assembly_tangent(&b->assembly, b->displacement, SB_TANGENT_QUASI, kept->made.stiffness, &b->matrix);
    b->assembly.batch_quats = rotations;
    sbi_body_add_mass(b, kept->made.mass);
    memset(b->work, 0, bytes);
    memset(b->work2, 0, bytes);
    sbi_step_mask(b, b->work, b->work2);
    result = sbi_body_settle_preconditioner(b, &step->info->error);
    if (result != SB_OK)
        return result;
    sbi_precond_set_memory(b->precond, kept->made.before);
    result = sbi_pcg_update_preconditioner(b->precond, &b->matrix, kept->positions[kept->made.slot], &step->guests,
                                           &b->pcg, &step->info->error);
    sbi_precond_set_memory(b->precond, memory);
    return result;
}

SBI_API sb_result sbi_kept_begin(sbi_step *step)
{
    sb_body *b = step->body;
    sb_result result;
    if (!step->keeps || b->kept->current)
        return SB_OK;
    result = sbi_kept_make(step);
    b->kept->current = result == SB_OK;
    return result;
}

/* residual -= A' x0, x0 in body->work; work2 = that of free rows: rows of supports are masked in the matrix. */
static void sbi_kept_subtract_product(sb_body *b)
{
    const sb_matrix *matrix = &b->matrix;
    const sb_real(*row)[9] = (const sb_real(*)[9])b->support_blocks;
    sb_matrix_multiply(matrix, &b->work[0].x, &b->work2[0].x, &b->jobs);
    for (int i = 0; i < matrix->row_count; i++) {
        sb_vec3 sum = sb_v3(0, 0, 0);
        int has_row = b->fixed[i] && b->node_component[i] >= 0;
        for (int k = matrix->row_start[i]; has_row && k < matrix->row_end[i]; k++, row++)
            sum = sb_v3_add(sum, sbi_step_block_product(*row, b->work[matrix->columns[k]]));
        b->residual[i] = sb_v3_sub(b->residual[i], has_row ? sum : b->work2[i]);
    }
}

SBI_API void sbi_kept_add_coasting(sbi_step *step)
{
    sb_body *b = step->body;
    int n = b->domain.node_count;
    sb_real mass = sbi_step_mass_factor(step);
    for (int i = 0; i < n; i++)
        b->work[i] = sbi_step_coast(step, i);
    sbi_body_mass_multiply(b, b->work, b->work2);
    for (int i = 0; i < n; i++)
        b->residual[i] = sb_v3_madd(b->residual[i], mass, b->work2[i]);
    sbi_kept_subtract_product(b);
}

/* ---- whether it has served ---- */

static double sbi_kept_work(int count, const sb_vec3 *a, const sb_vec3 *b)
{
    double sum = 0;
    for (int i = 0; i < count; i++)
        sum += (double)a[i].x * (double)b[i].x + (double)a[i].y * (double)b[i].y + (double)a[i].z * (double)b[i].z;
    return sum;
}

/* y.A y, y in body->work. */
static double sbi_kept_true_work(const sbi_step *step)
{
    sb_body *b = step->body;
    int n = b->domain.node_count;
    double stiffness = (double)sbi_assembly_work_along(&b->assembly, b->work), mass;
    sbi_body_mass_multiply(b, b->work, b->work2);
    mass = sbi_kept_work(n, b->work, b->work2);
    return (double)sbi_step_stiffness_factor(step) * stiffness + (double)sbi_step_mass_factor(step) * mass;
}

/* work = y = x - x0; 0: all nodes coast. */
static int sbi_kept_take_change(const sbi_step *step)
{
    sb_body *b = step->body;
    int changes = 0;
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 y = sb_v3_sub(b->increment[i], sbi_step_coast(step, i));
        changes |= !(y.x == 0 && y.y == 0 && y.z == 0);
        b->work[i] = y;
    }
    return changes;
}

SBI_API int sbi_kept_was_near(const sbi_step *step)
{
    const double most = 0.25; /* below 1/3, from which on a mode grows */
    sb_body *b = step->body;
    double kept;
    if (!sbi_kept_take_change(step)) /* a start that was good enough: A' has had no say */
        return 1;
    kept = sbi_matrix_work(&b->matrix, &b->work[0].x, &b->jobs);
    return fabs(sbi_kept_true_work(step) - kept) <= fmin((double)b->kept->angle, most) * kept;
}
