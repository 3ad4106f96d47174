/* body_damping: Rayleigh damping D = alpha M + beta K, of a body and of its regions. */
#include "body.h"
#include "body_private.h"
#include "live_private.h"

#include <string.h>

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

/* What a region damps with: its own, or the body's. */
static void sbi_body_begin_regions(sb_body *body)
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

/* ---- setters ---- */

static int sbi_body_is_damping(sb_real alpha, sb_real beta)
{
    return alpha >= 0 && beta >= 0 && sb_is_finite(alpha) && sb_is_finite(beta);
}

SB_API sb_result sb_body_set_damping(sb_body *body, sb_real alpha, sb_real beta)
{
    const sb_real damping[2] = {alpha, beta};
    if (!body || !sbi_body_is_damping(alpha, beta))
        return SB_ERROR_ARGUMENT;
    if (body->integrator == SB_CENTRAL_DIFFERENCE && beta > 0)
        return SB_ERROR_UNSUPPORTED;
    body->damping_mass = alpha;
    body->damping_stiffness = beta;
    if (body->regional_damping)
        sbi_body_set_regions(body, 0);
    sbi_body_tell(body, SBI_COMMAND_DAMPING, 0, 0, NULL, 0, damping, 2);
    return SB_OK;
}

SB_API sb_result sb_body_set_region_damping(sb_body *body, int region, sb_real alpha, sb_real beta, sb_error *error)
{
    const sb_real damping[2] = {alpha, beta};
    sb_result result;
    int at, found, regional;
    if (!body || !sbi_body_is_damping(alpha, beta))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a region's damping needs a body and finite alpha, beta >= 0");
    if (body->integrator == SB_CENTRAL_DIFFERENCE)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "SB_CENTRAL_DIFFERENCE damps all regions alike");
    at = sbi_body_find_region(body->material_regions, body->material_count, region, &found);
    if (!found)
        return sbi_fail(error, SB_ERROR_INDEX, "the mesh has no region %d", region);
    regional = body->regional_damping;
    sbi_body_begin_regions(body);
    body->regional_damping = 1;
    result = sbi_body_reserve_damping(body, NULL, 0, error);
    body->regional_damping = regional;
    if (result != SB_OK)
        return result;
    body->region_alpha[at] = alpha;
    body->region_beta[at] = beta;
    sbi_body_set_regions(body, 1);
    sbi_body_tell(body, SBI_COMMAND_REGION_DAMPING, region, 0, NULL, 0, damping, 2);
    return SB_OK;
}
