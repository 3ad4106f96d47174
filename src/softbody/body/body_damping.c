/* body_damping: Rayleigh damping D = alpha M + beta K of regions, and what steps need for it. */
#include "body.h"
#include "body_private.h"
#include "live_private.h"

#include <string.h>

/* ---- Newton iterations that materials need ---- */

/* 1 when one linearised iteration is what SB_AUTO means. Newmark has no damping of its own, so that the errors of
 * linearised steps add up until the body explodes: only a linear body may take them. */
static int sbi_body_is_one_step(const sb_body *body, sb_material_model model)
{
    return model == SB_LINEAR ||
           (body->integrator == SB_EULER && (model == SB_COROTATED || model == SB_COROTATED_INVERTIBLE));
}

SBI_API int sbi_body_max_newton(const sb_body *body)
{
    if (body->max_newton != SB_AUTO)
        return body->max_newton;
    for (int i = 0; i < body->material_count; i++)
        if (!sbi_body_is_one_step(body, body->materials[i].model))
            return 20;
    return 1;
}

/* ---- of regions ---- */

SBI_API int sbi_body_take_regions(sb_body *body)
{
    size_t count = (size_t)body->material_count;
    body->region_alpha = (sb_real *)sbi_alloc_zeroed(&body->allocator, count, 3 * sizeof(sb_real));
    if (!body->region_alpha)
        return 0;
    body->region_beta = body->region_alpha + count;
    body->region_factors = body->region_beta + count;
    return 1;
}

SBI_API int sbi_body_copy_regions(sb_body *to, const sb_body *from)
{
    to->material_count = from->material_count;
    if (!sbi_body_take_regions(to))
        return 0;
    to->regional_damping = from->regional_damping;
    memcpy(to->region_alpha, from->region_alpha, (size_t)from->material_count * 3 * sizeof(sb_real));
    return 1;
}

SBI_API int sbi_body_has_beta(const sb_body *body)
{
    for (int i = 0; body->regional_damping && i < body->material_count; i++)
        if (body->region_beta[i] > 0)
            return 1;
    return !body->regional_damping && body->damping_stiffness > 0;
}

SBI_API void sbi_body_begin_regions(sb_body *body)
{
    for (int i = 0; i < body->material_count && !body->regional_damping; i++) {
        body->region_alpha[i] = body->damping_mass;
        body->region_beta[i] = body->damping_stiffness;
    }
}

/* Steps that go on from a stiffness at their start keep it: those of several iterations, and of several regions unless
 * no velocity is in their residual. */
SBI_API sb_result sbi_body_reserve_damping(sb_body *body, const sb_material *materials, int count, sb_error *error)
{
    int needed = body->max_newton > 1 || (body->regional_damping && body->integrator != SB_EULER);
    for (int i = 0; i < count && body->max_newton == SB_AUTO; i++)
        needed |= !sbi_body_is_one_step(body, materials[i].model);
    if (!needed || body->damping_blocks || body->integrator == SB_CENTRAL_DIFFERENCE)
        return SB_OK;
    body->damping_blocks =
        (sb_real(*)[9])sbi_alloc(&body->allocator, (size_t)sbi_matrix_capacity(&body->matrix) + 1, 9 * sizeof(sb_real));
    if (!body->damping_blocks)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the damping of %d blocks", body->matrix.block_count);
    return SB_OK;
}

SBI_API void sbi_body_set_regions(sb_body *body, int regional)
{
    body->regional_damping = regional;
    sbi_body_sum_damping(body);
    body->acceleration_known = 0;
}
