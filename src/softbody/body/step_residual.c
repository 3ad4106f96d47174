/* step_residual: forces, tangent and residual of a step or a static solve.
 *
 * Both solve r(u) = M a + D v + f_int(u) - f_ext = 0 with a = ca (u - start) + a0 and v = cv (u - start) + v0;
 * a static solve has ca = cv = 0. So A = dr/du = (ca + alpha cv) M + (1 + beta cv) K, and one iteration is
 * A du = -r. Where regions have their own damping, D is the sum of alpha M of nodes (node_damping) and of beta K of
 * elements. */
#include <math.h>
#include <string.h>

#include "live_private.h"
#include "load.h"
#include "step_private.h"

/* ---- small vector loops ---- */

/* Axes that a norm counts: all; the free ones; the supported ones and those of slaves. */
typedef enum sbi_step_axes { SBI_STEP_ALL, SBI_STEP_FREE, SBI_STEP_HELD } sbi_step_axes;

static double sbi_step_square(const sb_body *body, int i, sb_vec3 v, sbi_step_axes axes)
{
    const sb_vec3 zero = sb_v3(0, 0, 0);
    if (axes == SBI_STEP_FREE)
        v = sbi_body_pick_axes(sbi_body_held(body, i), zero, v);
    if (axes == SBI_STEP_HELD)
        v = sbi_body_pick_axes(sbi_body_held(body, i), v, zero);
    return (double)v.x * (double)v.x + (double)v.y * (double)v.y + (double)v.z * (double)v.z;
}

static sb_real sbi_step_norm(const sb_body *body, const sb_vec3 *a, sbi_step_axes axes)
{
    double sum = 0;
    for (int i = 0; i < body->domain.node_count; i++)
        sum += sbi_step_square(body, i, a[i], axes);
    return sb_sqrt((sb_real)sum);
}

/* The same of one part's nodes. */
static sb_real sbi_step_part_norm(const sb_body *body, int part, const sb_vec3 *a, sbi_step_axes axes)
{
    const sb_matrix *parts = sbi_step_parts(body);
    double sum = 0;
    for (int k = parts->part_start[part]; k < parts->part_start[part + 1]; k++)
        sum += sbi_step_square(body, parts->part_rows[k], a[parts->part_rows[k]], axes);
    return sb_sqrt((sb_real)sum);
}

/* ---- one Newton iteration: residual ---- */

SBI_API sb_result sbi_step_force(sbi_step *step)
{
    sb_body *b = step->body;
    double begin = sbi_body_now(b);
    int bad = -1;
    if (!b->force_current) {
        bad = sbi_assembly_force(&b->assembly, b->displacement, b->internal);
        b->force_current = bad < 0;
    }
    step->info->seconds_force += sbi_body_now(b) - begin;
    if (bad >= 0)
        return sbi_fail_element(&step->info->error, SB_ERROR_INVERTED, bad,
                                "element %d is inside out, which its material does not allow", bad);
    return SB_OK;
}

/* Share of the assembled stiffness in A of each region; NULL: all have the same. */
static const sb_real *sbi_step_stiffness_factors(const sbi_step *step)
{
    const sb_body *b = step->body;
    if (!b->regional_damping || !step->dynamic || step->lagged_damping)
        return NULL;
    for (int i = 0; i < b->material_count; i++)
        b->region_factors[i] = 1 + b->region_beta[i] * step->cv;
    return b->region_factors;
}

/* matrix += cv node_damping */
static void sbi_step_add_node_damping(const sbi_step *step)
{
    sb_matrix *matrix = &step->body->matrix;
    for (int i = 0; i < matrix->row_count; i++) {
        sb_real *block = matrix->blocks[matrix->diagonal[i]], damping = step->cv * step->body->node_damping[i];
        block[0] += damping;
        block[4] += damping;
        block[8] += damping;
    }
}

/* The body's matrix with the damping stiffness in place of the tangent; borrowed. */
static sb_matrix sbi_step_damping_matrix(const sb_body *b)
{
    sb_matrix matrix = b->matrix;
    matrix.blocks = b->damping_blocks;
    return matrix;
}

/* matrix = A at the present displacement, whose forces are current. */
SBI_API void sbi_step_tangent(sbi_step *step, sb_tangent_kind kind)
{
    sb_body *b = step->body;
    double begin = sbi_body_now(b);
    sbi_kept_spoil(b);
    sbi_assembly_weighted_tangent(&b->assembly, b->displacement, kind, sbi_step_stiffness_factors(step),
                                  sbi_step_stiffness_factor(step), &b->matrix);
    if (step->dynamic || step->hold > 0)
        sbi_body_add_mass(b, sbi_step_mass_factor(step));
    if (step->dynamic && b->regional_damping)
        sbi_step_add_node_damping(step);
    if (step->lagged_damping) {
        sb_real factor = sbi_step_beta(b) * step->cv;
        for (int k = 0; k < b->matrix.block_count; k++)
            for (int c = 0; c < 9; c++)
                b->matrix.blocks[k][c] += factor * b->damping_blocks[k][c];
    }
    if (b->load_count)
        sbi_loads_add_tangent(b, b->displacement, kind, step->loads_factor, &b->matrix);
    if (step->push > 0)
        sbi_live_add_push_stiffness(b, step->push);
    step->info->seconds_tangent += sbi_body_now(b) - begin;
}

/* Keeps the stiffness at the start of the step for D. Were it to follow the iterations, the step would have no
 * potential to go down, and an indefinite or suddenly larger K would feed energy in. */
SBI_API sb_result sbi_step_keep_damping(sbi_step *step)
{
    sb_body *b = step->body;
    double begin;
    sb_result result = sbi_step_force(step);
    if (result != SB_OK)
        return result;
    begin = sbi_body_now(b);
    sbi_kept_spoil(b);
    sbi_assembly_weighted_tangent(&b->assembly, b->displacement, step->linearised ? SB_TANGENT_QUASI : SB_TANGENT_SPD,
                                  b->regional_damping ? b->region_beta : NULL,
                                  b->regional_damping ? b->damping_stiffness : 1, &b->matrix);
    memcpy(b->damping_blocks, b->matrix.blocks, (size_t)b->matrix.block_count * sizeof b->matrix.blocks[0]);
    step->info->seconds_tangent += sbi_body_now(b) - begin;
    step->lagged_damping = 1;
    return SB_OK;
}

/* out = K x with the K of D. Where it is not kept, it comes from A = cm M + ck K + (springs), which is assembled by
 * then. */
SBI_API void sbi_step_damping_product(const sbi_step *step, const sb_vec3 *x, sb_vec3 *out)
{
    sb_body *b = step->body;
    sb_matrix damping = sbi_step_damping_matrix(b);
    sb_real mass = sbi_step_mass_factor(step), stiffness = (sb_real)1 / sbi_step_stiffness_factor(step);
    if (step->lagged_damping) {
        sb_matrix_multiply(&damping, &x[0].x, &out[0].x, &b->jobs);
        return;
    }
    if (step->unassembled) {
        (void)sbi_assembly_multiply(&b->assembly, x, out);
        return;
    }
    sb_matrix_multiply(&b->matrix, &x[0].x, &out[0].x, &b->jobs);
    if (b->load_count)
        sbi_loads_subtract_product(b, x, step->loads_factor, out);
    if (step->push > 0)
        sbi_live_add_push_product(b, -step->push, x, out);
    sbi_body_mass_multiply(b, x, b->work2);
    for (int i = 0; i < b->domain.node_count; i++)
        out[i] = sb_v3_scale(stiffness, sb_v3_madd(out[i], -mass, b->work2[i]));
}

/* Compares residuals with these forces, too: those of each part with its own, for what is little beside the forces of
 * one part may be all that another feels. */
static void sbi_step_raise_scale(sbi_step *step, const sb_vec3 *force, sbi_step_axes axes)
{
    const sb_body *b = step->body;
    int parts = sbi_step_parts(b)->part_count;
    step->scale = sb_max(step->scale, sbi_step_norm(b, force, axes));
    for (int c = 0; parts > 1 && c < parts; c++)
        b->part_scale[c] = sb_max(b->part_scale[c], sbi_step_part_norm(b, c, force, axes));
}

/* residual += M (a + alpha v) + beta K v. */
static void sbi_step_add_dynamics(sbi_step *step)
{
    sb_body *b = step->body;
    int n = b->domain.node_count;
    for (int i = 0; i < n; i++)
        b->work[i] = sb_v3_madd(sbi_step_acceleration(step, i), sbi_step_alpha(b), sbi_step_velocity(step, i));
    sbi_body_mass_multiply(b, b->work, b->work2);
    for (int i = 0; i < n && b->regional_damping; i++)
        b->work2[i] = sb_v3_madd(b->work2[i], b->node_damping[i], sbi_step_velocity(step, i));
    for (int i = 0; i < n; i++)
        b->residual[i] = sb_v3_add(b->residual[i], b->work2[i]);
    sbi_step_raise_scale(step, b->work2, SBI_STEP_ALL);
    if (step->keeps)
        sbi_kept_add_coasting(step);
    if (step->keeps || !sbi_body_has_beta(b) || !step->has_velocity)
        return;
    for (int i = 0; i < n; i++)
        b->work[i] = sbi_step_velocity(step, i);
    sbi_step_damping_product(step, b->work, b->rhs);
    for (int i = 0; i < n; i++)
        b->residual[i] = sb_v3_madd(b->residual[i], sbi_step_beta(b), b->rhs[i]);
}

/* residual += stiffness of live_push.c times what a node has gone farther than it would at its speed. */
static void sbi_step_add_push(sbi_step *step)
{
    sb_body *b = step->body;
    for (int i = 0; i < b->domain.node_count; i++)
        b->work[i] = sb_v3_madd(sb_v3_sub(b->displacement[i], b->start[i]), -step->level * step->dt, b->velocity[i]);
    sbi_live_add_push_product(b, step->push, b->work, b->residual);
}

/* residual -= forces of the loads that follow the body. `external` holds the dead ones only until a solve ends. */
static void sbi_step_add_loads(sbi_step *step)
{
    sb_body *b = step->body;
    int n = b->domain.node_count;
    step->load_size = sbi_loads_force(b, b->displacement, step->loads_factor);
    for (int i = 0; i < n; i++)
        b->residual[i] = sb_v3_sub(b->residual[i], b->follower[i]);
    sbi_step_raise_scale(step, b->follower, SBI_STEP_ALL);
}

/* residual -= forces of contact. That of a linearised step is without: they change while it is solved. */
static void sbi_step_add_touch_residual(sbi_step *step)
{
    sb_body *b = step->body;
    sbi_step_evaluate_touch(step, NULL, 1, 1);
    memset(b->work, 0, (size_t)b->domain.node_count * sizeof(sb_vec3));
    sbi_step_add_touch_force(step, 1, b->work);
    sbi_step_add_touch_force(step, -1, b->residual);
    sbi_step_raise_scale(step, b->work, SBI_STEP_ALL);
}

SBI_API const sb_vec3 *sbi_step_unbalanced(const sbi_step *step)
{
    const sb_body *b = step->body;
    if (step->guests_begun)
        return (const sb_vec3 *)(const void *)sbi_pcg_guests(&b->pcg)->rest;
    return b->elimination ? b->elimination->reduced : b->residual;
}

/* What supports hold (N), as far as it is no more than ten times the loads: of thin bodies it is many times that. Where
 * nothing loads, all of it. */
static sb_real sbi_step_limit_reactions(const sbi_step *step, sb_real loads, sb_real reactions)
{
    return loads > 0 && !step->forces_only ? sb_max(loads, sb_min(10 * loads, reactions)) : sb_max(loads, reactions);
}

/* Loads before, supports that move, and reactions. */
static void sbi_step_scale_statics(sbi_step *step)
{
    sb_body *b = step->body;
    int parts = sbi_step_parts(b)->part_count;
    sb_real held = sbi_step_norm(b, b->internal, SBI_STEP_HELD);
    sbi_step_raise_scale(step, b->equilibrated, SBI_STEP_ALL);
    for (int c = 0; step->guests_begun && parts > 1 && c < parts; c++)
        b->part_scale[c] = sb_max(b->part_scale[c], sbi_step_guest_load(step, c));
    if (step->guests_begun)
        step->scale = sb_max(step->scale, sbi_step_guest_load(step, -1));
    step->scale = sb_max(step->scale, sbi_static_support_force(b, -1));
    step->held_scale = sb_max(step->scale, held);
    step->scale = sbi_step_limit_reactions(step, step->scale, held);
    for (int c = 0; parts > 1 && c < parts; c++) {
        b->part_scale[c] = sb_max(b->part_scale[c], sbi_static_support_force(b, c));
        b->part_scale[c] =
            sbi_step_limit_reactions(step, b->part_scale[c], sbi_step_part_norm(b, c, b->internal, SBI_STEP_HELD));
    }
}

/* A norm with what guests add to it in this part of the matrix (-1: in all). */
static sb_real sbi_step_with_guests(const sbi_step *step, sb_real norm, int part)
{
    if (!step->guests_begun)
        return norm;
    return (sb_real)sqrt((double)norm * (double)norm + sbi_step_guest_square(step, part));
}

/* residual = r(u), its norm on the free axes, and the force to compare it with. */
SBI_API void sbi_step_residual(sbi_step *step)
{
    sb_body *b = step->body;
    int n = b->domain.node_count;
    for (int i = 0; i < n; i++)
        b->residual[i] = sb_v3_sub(b->internal[i], b->external[i]);
    step->scale = 0;
    memset(b->part_scale, 0, (size_t)sbi_step_parts(b)->part_count * sizeof *b->part_scale);
    sbi_step_raise_scale(step, b->external, SBI_STEP_ALL);
    if (b->load_count)
        sbi_step_add_loads(step);
    if (step->push > 0)
        sbi_step_add_push(step);
    if (step->touch && !step->linearised)
        sbi_step_add_touch_residual(step);
    if (step->dynamic) {
        sbi_step_raise_scale(step, b->internal, SBI_STEP_ALL);
        sbi_step_add_dynamics(step);
    } else {
        sbi_step_scale_statics(step);
    }
    step->last_norm = step->norm;
    if (b->elimination)
        sbi_elimination_reduce(b->elimination, b->residual, b->elimination->reduced, NULL);
    if (step->guests_begun)
        sbi_step_guest_residual(step, sbi_step_parts(b));
    step->norm = sbi_step_with_guests(step, sbi_step_norm(b, sbi_step_unbalanced(step), SBI_STEP_FREE), -1);
}

/* 1 when the increment is below what the displacement's digits can show: nothing is left to gain. */
static int sbi_step_is_exhausted(const sb_body *b)
{
    sb_real largest = 0, size = 0;
    for (int i = 0; i < b->domain.node_count; i++) {
        largest = sb_max(largest, sb_v3_dot(b->increment[i], b->increment[i]));
        size = sb_max(size, sb_v3_dot(b->displacement[i], b->displacement[i]));
    }
    return largest <= 16 * SB_EPSILON * SB_EPSILON * size;
}

/* Forces, residual, and the tangent of a linearised step. */
SBI_API sb_result sbi_step_evaluate(sbi_step *step)
{
    sb_result result;
    step->moves_supports = sbi_step_supports_move(step);
    result = sbi_kept_force(step) ? SB_OK : sbi_step_force(step);
    if (result != SB_OK)
        return result;
    if (step->body->load_count)
        sbi_loads_fill(step->body, step->body->displacement);
    result = sbi_kept_begin(step);
    if (result != SB_OK)
        return result;
    sbi_unassembled_begin(step);
    if (!step->keeps && !step->unassembled &&
        (step->linearised || /* its residual may need K v, contact measures by it */
         (step->touch && step->iteration == 0)))
        sbi_step_tangent(step, SB_TANGENT_QUASI);
    if (step->iteration == 0 && step->body->load_count && sbi_loads_are_stiff(step->body)) {
        if (!step->linearised && !step->touch)
            sbi_step_tangent(step, SB_TANGENT_QUASI);
        sbi_loads_stiffen(step->body, step->body->displacement, step->loads_factor, 1, sbi_step_mass_factor(step));
    }
    if (step->touch && step->iteration == 0)
        result = sbi_step_begin_touch(step);
    if (result != SB_OK)
        return result;
    sbi_step_residual(step);
    if (!sb_is_finite(step->norm))
        return sbi_fail(&step->info->error, SB_ERROR_DIVERGED, "the forces are not finite");
    return SB_OK;
}

SBI_API int sbi_step_parts_meet(sbi_step *step, sb_real rounding)
{
    const sb_body *b = step->body;
    int parts = sbi_step_parts(b)->part_count, meet = 1;
    step->info->residual = 0;
    for (int c = 0; c < parts; c++) {
        sb_real norm = step->norm;
        sb_real scale = parts > 1 ? b->part_scale[c] : step->scale;
        if (parts > 1)
            norm = sbi_step_with_guests(step, sbi_step_part_norm(b, c, sbi_step_unbalanced(step), SBI_STEP_FREE), c);
        if (scale > 0)
            step->info->residual = sb_max(step->info->residual, norm / scale);
        meet &= norm <= step->tolerance * scale || norm <= rounding;
    }
    return meet && (!step->guests_begun || sbi_step_lone_guests_meet(step, rounding));
}

/* 1 when there is nothing left of the guests' own rows. */
static int sbi_step_guests_meet(const sbi_step *step, sb_real rounding)
{
    if (!step->guests_begun)
        return 1;
    return sbi_step_guest_square(step, -1) <= (double)(step->tolerance * step->scale * step->tolerance * step->scale) &&
           sbi_step_lone_guests_meet(step, rounding);
}

SBI_API int sbi_step_guests_lag(const sbi_step *step)
{
    if (step->patience == 0 || step->given.count == 0)
        return 0;
    return step->linearised ? step->guests_left > 0 : !sbi_step_guests_meet(step, sbi_step_rounding(step));
}

SBI_API sb_real sbi_step_rounding(const sbi_step *step)
{
    return 16 * SB_EPSILON * (step->body->force_unit + step->load_size);
}

/* 1 when the residual is small enough, or as small as rounding lets it become. */
SBI_API int sbi_step_is_converged(sbi_step *step)
{
    sb_real rounding = sbi_step_rounding(step);
    int meet = sbi_step_parts_meet(step, step->iteration > 0 ? rounding : 0);
    if (!meet && step->iteration > 0 && sbi_step_is_exhausted(step->body))
        meet = sbi_step_guests_meet(step, rounding);
    return !step->moves_supports && meet;
}

SBI_API int sbi_step_allows_inversion(const sb_body *b)
{
    for (int i = 0; i < b->material_count; i++)
        if (!sb_material_allows_inversion(b->materials[i].model))
            return 0;
    return 1;
}
