/* step_start: where a static solve starts from: its linear solution, with the rotations of that held in one system. */
#include <string.h>

#include "step_private.h"

/* The corotated material with the same moduli, relaxed as those of a solve of this duration (s) are. */
static sb_material sbi_start_twin(const sb_material *material, sb_real duration)
{
    sb_material relaxed = sbi_material_relaxed(material, sbi_prony_factor(material, duration)), twin;
    if (sb_material_is_linear(material->model))
        return *material;
    memset(&twin, 0, sizeof twin);
    twin.model = SB_COROTATED;
    twin.lambda = relaxed.lambda;
    twin.mu = relaxed.mu;
    twin.density = material->density;
    return twin;
}

SBI_API void sbi_start_use_twins(sb_body *b, sb_real duration)
{
    for (int i = 0; i < b->material_count; i++)
        b->twins[i] = sbi_start_twin(&b->materials[i], duration);
    sbi_assembly_set_materials(&b->assembly, b->twins, b->material_count, b->cell_material);
    sbi_assembly_reset_rotations(&b->assembly);
    b->force_current = 0;
}

SBI_API void sbi_start_use_own(sb_body *b, sb_real duration)
{
    sbi_assembly_set_materials(&b->assembly, b->materials, b->material_count, b->cell_material);
    sbi_assembly_restore_rotations(&b->assembly);
    sbi_step_enter(b, duration);
    b->force_current = 0;
}

SBI_API sb_result sbi_start_hold(sbi_step *step)
{
    sb_result result;
    step->kind = SB_TANGENT_QUASI;
    sbi_step_tangent(step, step->kind);
    result = sbi_step_make_system(step);
    if (result == SB_OK)
        result = sbi_step_solve_system(step);
    if (result == SB_OK)
        sbi_step_trial(step, 1);
    return result;
}

/* The same, whose forces are not current. SB_ERROR_UNSUPPORTED where forces are not far from balance there already:
 * measured over the static solves of the tests, it saves 2 to 9 iterations of 8 to 34 above this bound and costs one
 * below it. */
static sb_result sbi_start_smooth(sbi_step *step)
{
    const sb_real far = 2; /* of the loads */
    sb_result result = sbi_step_evaluate(step);
    if (result != SB_OK)
        return result;
    if (!(step->norm > far * step->scale))
        return SB_ERROR_UNSUPPORTED;
    return sbi_start_hold(step);
}

/* body->previous = the smoothed end of the increment, which stays, as does the displacement. */
static sb_result sbi_start_find(sbi_step *step, sb_real duration)
{
    sb_body *b = step->body;
    size_t bytes = (size_t)b->domain.node_count * sizeof(sb_vec3);
    sb_result result, back;
    sbi_step_trial(step, 1);
    memcpy(b->previous, b->increment, bytes);
    memcpy(b->displacement, b->work2, bytes);
    sbi_start_use_twins(b, duration);
    result = sbi_start_smooth(step);
    memcpy(b->increment, b->previous, bytes);
    memcpy(b->previous, b->work2, bytes);
    memcpy(b->displacement, b->converged, bytes);
    sbi_start_use_own(b, duration);
    back = sbi_step_evaluate(step);
    return back != SB_OK ? back : result;
}

SBI_API int sbi_static_may_start(const sbi_step *step, sb_start start)
{
    const sb_body *b = step->body;
    if (start == SB_START_PRESENT || step->info->newton_iterations > 0 || step->touch || step->given.count > 0 ||
        b->domain.single_rotation || sbi_step_is_linear(b))
        return 0;
    for (int i = 0; start == SB_START_AUTO && i < b->domain.node_count; i++)
        if (sb_v3_dot(b->displacement[i], b->displacement[i]) > 0)
            return 0;
    return 1;
}

SBI_API sb_result sbi_static_start(sbi_step *step, sb_real duration)
{
    sb_body *b = step->body;
    sb_result result = sbi_step_solve(step), found;
    if (result != SB_OK)
        return result;
    found = sbi_start_find(step, duration);
    if (found != SB_OK || !sbi_step_take_lower(step, b->previous)) {
        sbi_step_forget_error(step->info);
        return sbi_step_advance(step);
    }
    step->iteration++;
    step->norm = step->last_norm = 0;
    return sbi_step_linearise(step);
}
