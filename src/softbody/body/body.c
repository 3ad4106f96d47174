/* body: made and taken away; settings, and who hears of changes. */
#include "body.h"
#include "body_private.h"
#include "../fem/assembly_patch.h"
#include "live_private.h"
#include "state_part.h"

#include <string.h>

#define SBI_BODY_COOKIE 0x5b0d1u

SB_API sb_body_def sb_default_body_def(void)
{
    sb_body_def def;
    memset(&def, 0, sizeof def);
    def.integration = SB_INTEGRATION_AUTO;
    def.mass = SB_MASS_LUMPED;
    def.integrator = SB_EULER;
    def.preconditioner = SB_PRECOND_AUTO;
    def.levels = NULL;
    def.level_count = 0;
    def.slack = 0;
    def.tolerance = (sb_real)1e-3;
    def.max_iterations = 500;
    def.max_newton = SB_AUTO;
    def.spectral_radius = (sb_real)0.5;
    def.max_substeps = 10000;
    def.newton_tolerance = (sb_real)1e-6;
    def.cookie = SBI_BODY_COOKIE;
    return def;
}

/* ---- creation: arguments ---- */

SBI_API sb_result sbi_body_check_settings(const sb_body_def *def, sb_error *error)
{
    if (!sb_v3_is_finite(def->gravity))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "def.gravity is not finite");
    if (!(def->damping_mass >= 0) || !(def->damping_stiffness >= 0) || !sb_is_finite(def->damping_mass) ||
        !sb_is_finite(def->damping_stiffness))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.damping_mass %g and def.damping_stiffness %g must be >= 0",
                        (double)def->damping_mass, (double)def->damping_stiffness);
    if (!(def->tolerance > 0) || !(def->tolerance < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.tolerance %g must be in (0, 1)", (double)def->tolerance);
    if (!(def->newton_tolerance > 0) || !(def->newton_tolerance < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.newton_tolerance %g must be in (0, 1)",
                        (double)def->newton_tolerance);
    if (def->max_iterations < 1 || (def->max_newton < 1 && def->max_newton != SB_AUTO))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.max_iterations %d and def.max_newton %d must be >= 1",
                        def->max_iterations, def->max_newton);
    if (def->integrator < SB_EULER || def->integrator > SB_CENTRAL_DIFFERENCE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.integrator %d is unknown", (int)def->integrator);
    if (!(def->spectral_radius >= 0) || !(def->spectral_radius <= 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.spectral_radius %g must be in [0, 1]",
                        (double)def->spectral_radius);
    if (def->max_substeps < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.max_substeps %d must be >= 1", def->max_substeps);
    if (def->integration < SB_INTEGRATION_AUTO || def->integration > SB_INTEGRATION_PATCH)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.integration %d is unknown", (int)def->integration);
    if (def->mass != SB_MASS_LUMPED && def->mass != SB_MASS_CONSISTENT && def->mass != SB_MASS_REDUCED)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.mass %d is unknown", (int)def->mass);
    if (!(def->slack >= 0) || !(def->slack <= 1000))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.slack %g must be in [0, 1000]", (double)def->slack);
    if (def->allocator.alloc && !def->allocator.release)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.allocator has alloc but no release");
    if (def->integrator == SB_CENTRAL_DIFFERENCE && def->mass != SB_MASS_LUMPED)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "SB_CENTRAL_DIFFERENCE needs def.mass SB_MASS_LUMPED");
    if (def->integrator == SB_CENTRAL_DIFFERENCE && def->damping_stiffness > 0)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "SB_CENTRAL_DIFFERENCE damps with def.damping_mass, not with def.damping_stiffness %g",
                        (double)def->damping_stiffness);
    return SB_OK;
}

static sb_result sbi_body_check_def(const sb_body_def *def, sb_error *error)
{
    sb_result result;
    if (def->cookie != SBI_BODY_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by sb_default_body_def");
    if (!def->mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.mesh is NULL");
    if (def->domain && (def->integration != SB_INTEGRATION_AUTO || def->single_rotation))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "def.domain has its own points: def.integration and def.single_rotation do not go with it");
    if (def->region_material_count < 0 || (def->region_material_count > 0 && !def->region_materials))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.region_materials is NULL or its count negative");
    result = sbi_body_check_settings(def, error);
    for (int i = 0; i < def->region_material_count && result == SB_OK; i++)
        result = sbi_body_check_material(&def->region_materials[i].material, def->single_rotation, error);
    return result;
}

/* ---- creation: topology ---- */

/* Parts of the mesh, elements of each node, and the matrix pattern. */
static sb_result sbi_body_make_topology(sb_body *body, const sb_mesh *mesh, sb_error *error)
{
    sb_result result =
        sb_mesh_components(mesh, &body->allocator, &body->element_component, &body->component_count, error);
    if (result == SB_OK)
        result = sb_mesh_node_elements(mesh, &body->allocator, &body->node_elements, error);
    if (result == SB_OK)
        result = sbi_patches_create(&body->domain, &body->allocator, &body->assembly.patches, error);
    if (result == SB_OK)
        result = sbi_body_make_matrix(body, 0, NULL, NULL, &body->matrix, error);
    return result;
}

/* ---- creation and its end ---- */

static sb_result sbi_body_build(sb_body *body, const sb_body_def *def, sb_error *error)
{
    const sb_allocator *allocator = &body->allocator;
    sb_result result = def->domain ? sbi_domain_copy(def->domain, def->mesh, allocator, &body->domain, error)
                                   : sb_domain_create(def->mesh, def->integration, def->single_rotation, allocator,
                                                      &body->domain, error);
    body->own_points = def->domain != NULL;
    if (result == SB_OK)
        result = sbi_body_make_materials(body, def, error);
    if (result == SB_OK)
        result = sbi_body_make_topology(body, def->mesh, error);
    if (result == SB_OK)
        result = sbi_live_create(body, def, error);
    if (result == SB_OK)
        result = sbi_body_take_nodes(body, error);
    if (result == SB_OK)
        result = sbi_body_take_topology(body, error);
    if (result == SB_OK)
        result = sbi_body_make_preconditioner(body, def, error);
    if (result == SB_OK)
        result = sb_pcg_workspace_create(body->node_capacity, allocator, &body->pcg, error);
    if (result == SB_OK)
        result = sbi_body_prepare_assembly(body, error);
    if (result != SB_OK)
        return result;
    body->pcg.row_count = body->domain.node_count;
    memcpy(body->reference, def->mesh->nodes, (size_t)body->domain.node_count * sizeof(sb_vec3));
    sbi_body_label_nodes(body);
    result = def->fibres ? sb_body_set_fibres(body, def->fibres, error) : SB_OK;
    if (result == SB_OK && def->second_fibres && def->slack > 0)
        result = sbi_fail(error, SB_ERROR_UNSUPPORTED, "a mesh that may change (def.slack) has one family of fibres");
    if (result == SB_OK && def->second_fibres)
        result = sb_body_set_second_fibres(body, def->second_fibres, error);
    for (int i = 0; i < body->material_count && result == SB_OK; i++)
        result = sbi_body_prepare_material(body, i, body->materials + i, error);
    if (result == SB_OK)
        result = sbi_live_prepare(body, error);
    if (result != SB_OK)
        return result;
    sbi_body_materials_changed(body);
    sb_body_reset(body);
    return sbi_body_reserve_damping(body, body->materials, body->material_count, error);
}

SB_API sb_result sb_body_create(const sb_body_def *def, sb_body **body, sb_error *error)
{
    sb_body *made;
    sb_result result;
    if (!def || !body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_create needs a def and a place for the body");
    result = sbi_body_check_def(def, error);
    if (result != SB_OK)
        return result;
    made = (sb_body *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a body");
    made->allocator = def->allocator;
    made->jobs = def->jobs;
    made->clock = def->clock;
    made->mass_kind = def->mass;
    made->integrator = def->integrator;
    made->gravity = def->gravity;
    made->damping_mass = def->damping_mass;
    made->damping_stiffness = def->damping_stiffness;
    made->tolerance = def->tolerance;
    made->newton_tolerance = def->newton_tolerance;
    made->max_iterations = def->max_iterations;
    made->max_newton = def->max_newton;
    made->auto_solver = def->preconditioner == SB_PRECOND_AUTO;
    made->spectral_radius = def->spectral_radius;
    made->max_substeps = def->max_substeps;
    result = sbi_body_build(made, def, error);
    if (result != SB_OK) {
        sb_body_destroy(made);
        return result;
    }
    *body = made;
    return SB_OK;
}

SB_API void sb_body_destroy(sb_body *body)
{
    if (!body)
        return;
    sbi_body_tell(body, SBI_COMMAND_DESTROY, 0, 0, NULL, 0, NULL, 0);
    sbi_live_end(body);
    sbi_state_parts_free(body);
    sbi_body_release(body);
}

/* ---- settings ---- */

SB_API sb_result sb_body_set_gravity(sb_body *body, sb_vec3 gravity)
{
    if (!body)
        return SB_ERROR_ARGUMENT;
    if (!sb_v3_is_finite(gravity))
        return SB_ERROR_NOT_FINITE;
    body->gravity = gravity;
    sbi_body_tell(body, SBI_COMMAND_GRAVITY, 0, 0, NULL, 0, &gravity.x, 3);
    return SB_OK;
}

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

SB_API sb_result sb_body_set_solver(sb_body *body, sb_real tolerance, int max_iterations)
{
    if (!body || !(tolerance > 0) || !(tolerance < 1) || max_iterations < 1)
        return SB_ERROR_ARGUMENT;
    body->tolerance = tolerance;
    body->max_iterations = max_iterations;
    sbi_body_tell(body, SBI_COMMAND_SOLVER, max_iterations, 0, NULL, 0, &tolerance, 1);
    return SB_OK;
}
