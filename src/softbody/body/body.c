/* body: made and taken away; settings, and who hears of changes. */
#include "body.h"
#include "body_private.h"
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
    if (def->integration < SB_INTEGRATION_AUTO || def->integration > SB_INTEGRATION_BBAR)
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

/* ---- creation: memory ---- */

/* The vectors by node, which a live mesh carries over when it grows. */
enum { SBI_BODY_VECTORS = 26 };
static void sbi_body_list_vectors(sb_body *body, sb_vec3 **vectors[SBI_BODY_VECTORS])
{
    sb_vec3 **list[SBI_BODY_VECTORS] = {&body->reference,
                                        &body->position,
                                        &body->displacement,
                                        &body->velocity,
                                        &body->target,
                                        &body->dead_load,
                                        &body->acceleration,
                                        &body->internal,
                                        &body->external,
                                        &body->follower,
                                        &body->equilibrated,
                                        &body->residual,
                                        &body->rhs,
                                        &body->increment,
                                        &body->reaction,
                                        &body->velocity0,
                                        &body->acceleration0,
                                        &body->start,
                                        &body->saved_velocity,
                                        &body->saved_acceleration,
                                        &body->saved_reaction,
                                        &body->saved_external,
                                        &body->saved_internal,
                                        &body->converged,
                                        &body->work,
                                        &body->work2};
    memcpy(vectors, list, sizeof list);
}

/* Lays out every array by node slot; walked once to measure and once to hand out. */
static void sbi_body_layout_nodes(sb_body *body, sbi_arena *arena)
{
    size_t n = (size_t)body->node_capacity;
    sb_vec3 **vectors[SBI_BODY_VECTORS];
    sbi_body_list_vectors(body, vectors);
    for (int i = 0; i < SBI_BODY_VECTORS; i++)
        *vectors[i] = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    body->lumped_mass = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    body->load_mass = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    body->fixed = (unsigned char *)sbi_arena_take(arena, n, 1);
    body->node_component = (int *)sbi_arena_take(arena, n, sizeof(int));
}

/* The same for what depends on cells, parts and the matrix. */
static void sbi_body_layout_topology(sb_body *body, sbi_arena *arena)
{
    size_t parts = (size_t)sbi_live_part_room(body);
    body->part_scale =
        (sb_real *)sbi_arena_take(arena, (size_t)sbi_matrix_most_parts(body->node_capacity), sizeof(sb_real));
    if (body->mass_kind != SB_MASS_LUMPED)
        body->mass_blocks =
            (sb_real *)sbi_arena_take(arena, (size_t)sbi_matrix_capacity(&body->matrix), sizeof(sb_real));
    body->support_grams = (double(*)[36])sbi_arena_take(arena, parts, 36 * sizeof(double));
    body->component_low = (sb_vec3 *)sbi_arena_take(arena, parts, sizeof(sb_vec3));
    body->component_high = (sb_vec3 *)sbi_arena_take(arena, parts, sizeof(sb_vec3));
    body->component_faces = (int(*)[6])sbi_arena_take(arena, parts, sizeof body->component_faces[0]);
    body->tie_of = (int *)sbi_arena_take(arena, parts, sizeof(int));
    sbi_assembly_layout(&body->assembly, &body->domain, body->matrix.block_count, body->material_count, arena);
}

/* One block of zeros for a layout, or NULL. */
static void *sbi_body_take_layout(sb_body *body, void (*layout)(sb_body *body, sbi_arena *arena))
{
    sbi_arena arena = {NULL, 0, 0};
    unsigned char *base;
    layout(body, &arena);
    base = arena.overflow || arena.used > (size_t)-1 - 64
               ? NULL
               : (unsigned char *)sbi_alloc_zeroed(&body->allocator, arena.used + 64, 1);
    if (!base)
        return NULL;
    arena.base = base + (64 - (size_t)((uintptr_t)base & 63));
    arena.used = 0;
    layout(body, &arena);
    return base;
}

SBI_API sb_result sbi_body_take_nodes(sb_body *body, sb_error *error)
{
    body->memory = sbi_body_take_layout(body, sbi_body_layout_nodes);
    return body->memory ? SB_OK
                        : sbi_fail(error, SB_ERROR_MEMORY, "no memory for the state of %d nodes", body->node_capacity);
}

SBI_API sb_result sbi_body_take_topology(sb_body *body, sb_error *error)
{
    body->topology_memory = sbi_body_take_layout(body, sbi_body_layout_topology);
    return body->topology_memory
               ? SB_OK
               : sbi_fail(error, SB_ERROR_MEMORY, "no memory for the loops over %d elements", body->domain.cell_count);
}

SBI_API void sbi_body_copy_nodes(sb_body *to, sb_body *from)
{
    size_t n = (size_t)sbi_min_int(to->node_capacity, from->node_capacity);
    sb_vec3 **out[SBI_BODY_VECTORS], **in[SBI_BODY_VECTORS];
    sbi_body_list_vectors(to, out);
    sbi_body_list_vectors(from, in);
    for (int i = 0; i < SBI_BODY_VECTORS; i++)
        memcpy(*out[i], *in[i], n * sizeof(sb_vec3));
    memcpy(to->lumped_mass, from->lumped_mass, n * sizeof(sb_real));
    memcpy(to->load_mass, from->load_mass, n * sizeof(sb_real));
    memcpy(to->fixed, from->fixed, n);
    memcpy(to->node_component, from->node_component, n * sizeof(int));
}

SBI_API void sbi_body_swap_nodes(sb_body *a, sb_body *b)
{
    sb_vec3 **left[SBI_BODY_VECTORS], **right[SBI_BODY_VECTORS];
    sb_body other = *a;
    sbi_body_list_vectors(a, left);
    sbi_body_list_vectors(b, right);
    for (int i = 0; i < SBI_BODY_VECTORS; i++) {
        sb_vec3 *vector = *left[i];
        *left[i] = *right[i];
        *right[i] = vector;
    }
    a->lumped_mass = b->lumped_mass, b->lumped_mass = other.lumped_mass;
    a->load_mass = b->load_mass, b->load_mass = other.load_mass;
    a->fixed = b->fixed, b->fixed = other.fixed;
    a->node_component = b->node_component, b->node_component = other.node_component;
    a->memory = b->memory, b->memory = other.memory;
    a->node_capacity = b->node_capacity, b->node_capacity = other.node_capacity;
    a->assembly.reference = a->reference;
    b->assembly.reference = b->reference;
}

/* ---- creation: topology ---- */

/* Parts of the mesh, elements of each node, and the matrix pattern. */
static sb_result sbi_body_make_topology(sb_body *body, const sb_mesh *mesh, sb_error *error)
{
    const sb_domain *domain = &body->domain;
    sb_result result =
        sb_mesh_components(mesh, &body->allocator, &body->element_component, &body->component_count, error);
    if (result == SB_OK)
        result = sb_mesh_node_elements(mesh, &body->allocator, &body->node_elements, error);
    if (result == SB_OK)
        result = sb_matrix_create(domain->node_count, domain->cell_count, domain->nodes_per_cell, NULL, domain->cells,
                                  &body->allocator, &body->matrix, error);
    return result;
}

/* One side of a box, at `side` times `face`: a node at side times x joins the nodes that lie in it. */
static void sbi_body_enter_face(sb_real *face, int *nodes, sb_real x, sb_real side)
{
    if (side * x > side * *face) {
        *face = x + 0; /* no -0: the order of the nodes is not to show */
        *nodes = 0;
    }
    *nodes += x == *face;
}

SBI_API void sbi_body_enter_box(sb_body *body, int component, sb_vec3 x)
{
    sb_vec3 *low = body->component_low + component, *high = body->component_high + component;
    int *nodes = body->component_faces[component];
    sbi_body_enter_face(&low->x, nodes, x.x, -1);
    sbi_body_enter_face(&low->y, nodes + 1, x.y, -1);
    sbi_body_enter_face(&low->z, nodes + 2, x.z, -1);
    sbi_body_enter_face(&high->x, nodes + 3, x.x, 1);
    sbi_body_enter_face(&high->y, nodes + 4, x.y, 1);
    sbi_body_enter_face(&high->z, nodes + 5, x.z, 1);
}

SBI_API void sbi_body_leave_box(sb_body *body, int component, sb_vec3 x)
{
    sb_vec3 low = body->component_low[component], high = body->component_high[component];
    int *nodes = body->component_faces[component];
    nodes[0] -= x.x == low.x;
    nodes[1] -= x.y == low.y;
    nodes[2] -= x.z == low.z;
    nodes[3] -= x.x == high.x;
    nodes[4] -= x.y == high.y;
    nodes[5] -= x.z == high.z;
}

SBI_API int sbi_body_box_is_right(const sb_body *body, int component)
{
    const int *nodes = body->component_faces[component];
    return nodes[0] > 0 && nodes[1] > 0 && nodes[2] > 0 && nodes[3] > 0 && nodes[4] > 0 && nodes[5] > 0;
}

SBI_API void sbi_body_make_boxes(sb_body *body)
{
    for (int c = 0; c < body->component_count; c++) {
        body->component_low[c] = sb_v3(SB_REAL_MAX, SB_REAL_MAX, SB_REAL_MAX);
        body->component_high[c] = sb_v3(-SB_REAL_MAX, -SB_REAL_MAX, -SB_REAL_MAX);
        memset(body->component_faces[c], 0, sizeof body->component_faces[c]);
    }
    for (int i = 0; i < body->domain.node_count; i++)
        if (body->node_component[i] >= 0)
            sbi_body_enter_box(body, body->node_component[i], body->reference[i]);
}

static void sbi_body_label_by_elements(sb_body *body)
{
    const sb_index_lists *lists = &body->node_elements;
    for (int i = 0; i < body->domain.node_count; i++) {
        int first = lists->offsets[i];
        body->node_component[i] =
            first == lists->offsets[i + 1] ? -1 : body->element_component.items[lists->items[first]];
    }
}

SBI_API void sbi_body_label_nodes(sb_body *body)
{
    if (sbi_live_follows(body))
        sbi_live_label_nodes(body);
    else
        sbi_body_label_by_elements(body);
    for (int c = 0; c < body->component_count; c++)
        body->tie_of[c] = -1;
    for (int i = 0; i < body->domain.node_count; i++)
        if (body->node_component[i] < 0) /* it would make every system singular */
            body->fixed[i] = SB_XYZ;
    sbi_body_make_boxes(body);
}

/* ---- creation and its end ---- */

SBI_API sb_result sbi_body_prepare_assembly(sb_body *body, sb_error *error)
{
    uint64_t *node_colours =
        (uint64_t *)sbi_alloc(&body->allocator, (size_t)body->domain.node_count, sizeof *node_colours);
    if (!node_colours)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory to colour %d nodes", body->domain.node_count);
    body->assembly.jobs = &body->jobs;
    body->assembly.reference = body->reference;
    sbi_assembly_prepare(&body->assembly, &body->matrix, node_colours);
    sbi_free(&body->allocator, node_colours);
    return sbi_live_make_assembly(body, error);
}

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
    sb_allocator allocator;
    if (!body)
        return;
    sbi_body_tell(body, SBI_COMMAND_DESTROY, 0, 0, NULL, 0, NULL, 0);
    allocator = body->allocator;
    for (int i = 0; i < body->load_count; i++)
        sbi_load_release(&allocator, body->loads + i);
    sbi_free(&allocator, body->loads);
    sbi_free(&allocator, body->tie_gram);
    sbi_elimination_free(body->elimination);
    sb_pcg_workspace_free(&body->pcg);
    sb_preconditioner_free(body->precond);
    sb_matrix_free(&body->matrix);
    sb_index_table_free(&body->element_component);
    sb_index_lists_free(&body->node_elements);
    sbi_assembly_free_memory(&body->assembly, &allocator);
    sb_domain_free(&body->domain);
    sbi_free(&allocator, body->fibres);
    sbi_free(&allocator, body->support_blocks);
    sbi_free(&allocator, body->damping_blocks);
    sbi_free(&allocator, body->extra_start);
    sbi_free(&allocator, body->pattern_memory);
    sbi_free(&allocator, body->cell_material);
    sbi_free(&allocator, body->materials);
    sbi_free(&allocator, body->material_regions);
    sbi_free(&allocator, body->topology_memory);
    sbi_free(&allocator, body->memory);
    sbi_live_destroy(body);
    sbi_state_parts_free(body);
    sbi_free(&allocator, body);
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

SB_API sb_result sb_body_set_damping(sb_body *body, sb_real alpha, sb_real beta)
{
    const sb_real damping[2] = {alpha, beta};
    if (!body || !(alpha >= 0) || !(beta >= 0) || !sb_is_finite(alpha) || !sb_is_finite(beta))
        return SB_ERROR_ARGUMENT;
    if (body->integrator == SB_CENTRAL_DIFFERENCE && beta > 0)
        return SB_ERROR_UNSUPPORTED;
    body->damping_mass = alpha;
    body->damping_stiffness = beta;
    sbi_body_tell(body, SBI_COMMAND_DAMPING, 0, 0, NULL, 0, damping, 2);
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
