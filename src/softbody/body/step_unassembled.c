/* step_unassembled: linearised steps of clouds whose system is solved without its matrix.
 *
 * A row of a cloud's tangent has 30 to 100 blocks. To sum them from the points takes as long as ten products that go
 * from point to point, and the matrix has ten times the bytes of what the points keep. Where mass holds each node about
 * as firmly as stiffness does, conjugate gradients with nothing but a diagonal take a handful of products, and the
 * matrix is not made at all.
 *
 * The system is that of step_system.c: A = cm M + ck K + loads, rows and columns of supported axes masked. */
#include <string.h>

#include "load.h"
#include "step_private.h"

/* Largest diagonal entry of A over its mass for which the diagonal is left to do as preconditioner, unless the body is
 * to have none: the condition is then below some four times that. */
static const sb_real sbi_unassembled_most = 12;

/* ---- whether it serves ---- */

/* Masses of node i in A's diagonal (kg). */
static sb_real sbi_unassembled_mass(const sb_body *b, int i)
{
    return b->mass_blocks ? b->mass_blocks[b->matrix.diagonal[i]] : b->lumped_mass[i];
}

/* All of A is a matter of points, masses, and rows of springs. */
static int sbi_unassembled_may(const sbi_step *step)
{
    const sb_body *b = step->body;
    const sbi_assembly *assembly = &b->assembly;
    return step->linearised && step->dynamic && !step->lagged_damping && assembly->batched && assembly->node_diagonal &&
           !b->elimination && !step->touch && !step->pushed && step->guests.count == 0 && !b->regional_damping &&
           sbi_loads_are_rows(b);
}

/* node_diagonal = mean of each node's three diagonal entries of A. Returns the largest over its mass. */
static sb_real sbi_unassembled_weigh(const sbi_step *step)
{
    const sb_body *b = step->body;
    sb_real *diagonal = b->assembly.node_diagonal, largest = 0;
    sb_real mass = sbi_step_mass_factor(step), stiffness = sbi_step_stiffness_factor(step);
    for (int i = 0; i < b->domain.node_count; i++)
        diagonal[i] = stiffness * b->assembly.node_stiffness[i] + mass * sbi_unassembled_mass(b, i);
    sbi_loads_add_diagonal(b, step->loads_factor, diagonal);
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_real held = mass * sbi_unassembled_mass(b, i);
        if (!(held > 0))
            return SB_REAL_MAX;
        largest = sb_max(largest, diagonal[i] / held);
    }
    return largest;
}

SBI_API void sbi_unassembled_begin(sbi_step *step)
{
    const sb_body *b = step->body;
    sb_real most;
    step->unassembled = 0;
    if (!sbi_unassembled_may(step))
        return;
    most = b->auto_solver                                                   ? sbi_unassembled_most
           : sb_preconditioner_get_info(b->precond).kind == SB_PRECOND_NONE ? SB_REAL_MAX
                                                                            : (sb_real)0;
    step->unassembled = most > 0 && sbi_unassembled_weigh(step) <= most;
}

/* ---- the system ---- */

/* out = A x, supports not masked; held not NULL: only rows of nodes that it marks are right. Uses work2. */
static void sbi_unassembled_product(const sbi_step *step, const sb_vec3 *x, const unsigned char *held, sb_vec3 *out)
{
    sb_body *b = step->body;
    sb_real sign = b->load_count ? (sb_real)-1 : (sb_real)1; /* loads are subtracted */
    sb_real mass = sign * sbi_step_mass_factor(step), stiffness = sign * sbi_step_stiffness_factor(step);
    sbi_assembly_multiply_held(&b->assembly, x, held, out);
    sbi_body_mass_multiply(b, x, b->work2);
    for (int i = 0; i < b->domain.node_count; i++)
        out[i] = sb_v3_madd(sb_v3_scale(stiffness, out[i]), mass, b->work2[i]);
    if (!b->load_count)
        return;
    sbi_loads_subtract_product(b, x, step->loads_factor, out);
    for (int i = 0; i < b->domain.node_count; i++)
        out[i] = sb_v3_scale(-1, out[i]);
}

/* out = x on axes that are free, or on those that are not. */
static void sbi_unassembled_pick(const sb_body *b, const sb_vec3 *x, int supported, sb_vec3 *out)
{
    const sb_vec3 zero = sb_v3(0, 0, 0);
    for (int i = 0; i < b->domain.node_count; i++)
        out[i] = supported ? sbi_body_pick_axes(b->fixed[i], x[i], zero) : sbi_body_pick_axes(b->fixed[i], zero, x[i]);
}

/* y = A x of the masked system. Uses work and work2. */
static void sbi_unassembled_multiply(void *user, const sb_real *x, sb_real *y)
{
    const sbi_step *step = (const sbi_step *)user;
    sb_body *b = step->body;
    const sb_vec3 *in = (const sb_vec3 *)(const void *)x;
    sb_vec3 *out = (sb_vec3 *)(void *)y;
    if (step->moves_supports) /* else they are 0 there */
        sbi_unassembled_pick(b, in, 0, b->work);
    sbi_unassembled_product(step, step->moves_supports ? b->work : in, NULL, out);
    for (int i = 0; i < b->domain.node_count; i++)
        if (b->fixed[i])
            out[i] = sbi_body_pick_axes(b->fixed[i], sb_v3_scale(step->support_scale, in[i]), out[i]);
}

/* Mean entry of the diagonal (N/m): that of masked rows. */
static sb_real sbi_unassembled_scale(const sb_body *b)
{
    double sum = 0;
    for (int i = 0; i < b->domain.node_count; i++)
        sum += (double)b->assembly.node_diagonal[i];
    return (sb_real)(sum / b->domain.node_count);
}

SBI_API void sbi_unassembled_fill(sbi_step *step)
{
    sb_body *b = step->body;
    int n = b->domain.node_count;
    step->opens_gaps = 0;
    step->support_scale = sbi_unassembled_scale(b);
    for (int i = 0; i < n; i++) {
        b->matrix.fixed[i] = (unsigned char)(b->fixed[i] & SB_XYZ);
        b->rhs[i] = sb_v3_scale(-1, b->residual[i]);
    }
    if (step->moves_supports) {
        sbi_unassembled_pick(b, b->increment, 1, b->work);
        sbi_unassembled_product(step, b->work, NULL, b->previous);
        for (int i = 0; i < n; i++)
            b->rhs[i] = sb_v3_sub(b->rhs[i], b->previous[i]);
    }
    for (int i = 0; i < n; i++)
        if (b->fixed[i])
            b->rhs[i] = sbi_body_pick_axes(b->fixed[i], sb_v3_scale(step->support_scale, b->increment[i]), b->rhs[i]);
}

SBI_API const sbi_pcg_operator *sbi_unassembled_operator(sbi_step *step, sbi_pcg_operator *out)
{
    out->user = step;
    out->multiply = sbi_unassembled_multiply;
    out->diagonal = step->body->auto_solver ? step->body->assembly.node_diagonal : NULL;
    return out;
}

SBI_API void sbi_unassembled_reactions(const sbi_step *step)
{
    sb_body *b = step->body;
    const sb_vec3 zero = sb_v3(0, 0, 0);
    sbi_unassembled_product(step, b->increment, b->fixed, b->work);
    for (int i = 0; i < b->domain.node_count; i++)
        b->reaction[i] =
            sbi_body_pick_axes(b->node_component[i] < 0 ? 0 : b->fixed[i], sb_v3_add(b->residual[i], b->work[i]), zero);
}
