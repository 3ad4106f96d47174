/* body_arrays: a body's arrays, taken when it is made, carried over when its mesh changes, given back at its end. */
#include "body_private.h"
#include "live_private.h"
#include "rigid_private.h"

#include <string.h>

/* The vectors by node, which a live mesh carries over when it grows. */
enum { SBI_BODY_VECTORS = 27 };
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
                                        &body->previous,
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
    body->node_damping = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
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
    memcpy(to->node_damping, from->node_damping, n * sizeof(sb_real));
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
    a->node_damping = b->node_damping, b->node_damping = other.node_damping;
    a->load_mass = b->load_mass, b->load_mass = other.load_mass;
    a->fixed = b->fixed, b->fixed = other.fixed;
    a->node_component = b->node_component, b->node_component = other.node_component;
    a->memory = b->memory, b->memory = other.memory;
    a->node_capacity = b->node_capacity, b->node_capacity = other.node_capacity;
    a->assembly.reference = a->reference;
    b->assembly.reference = b->reference;
}

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

SBI_API void sbi_body_release(sb_body *body)
{
    sb_allocator allocator;
    if (!body)
        return;
    allocator = body->allocator;
    for (int i = 0; i < body->load_count; i++)
        sbi_load_release(&allocator, body->loads + i);
    sbi_rigids_free(&allocator, body->rigids);
    sbi_free(&allocator, body->tractions);
    sbi_free(&allocator, body->loads);
    sbi_free(&allocator, body->tie_gram);
    sbi_elimination_free(body->elimination);
    sb_pcg_workspace_free(&body->pcg);
    sb_preconditioner_free(body->precond);
    sb_matrix_free(&body->matrix);
    sb_index_table_free(&body->element_component);
    sb_index_lists_free(&body->node_elements);
    sbi_assembly_free(&body->assembly, &allocator);
    sb_domain_free(&body->domain);
    sbi_free(&allocator, body->kept);
    sbi_free(&allocator, body->fibres);
    sbi_free(&allocator, body->second_fibres);
    sbi_free(&allocator, body->substep_room);
    sbi_free(&allocator, body->support_blocks);
    sbi_free(&allocator, body->damping_blocks);
    sbi_free(&allocator, body->extra_start);
    sbi_free(&allocator, body->pattern_memory);
    sbi_free(&allocator, body->cell_material);
    sbi_free(&allocator, (void *)body->laws);
    sbi_free(&allocator, body->made_young);
    sbi_free(&allocator, body->region_alpha);
    sbi_free(&allocator, body->twins);
    sbi_free(&allocator, body->materials);
    sbi_free(&allocator, body->material_regions);
    sbi_free(&allocator, body->topology_memory);
    sbi_free(&allocator, body->memory);
    sbi_live_free(body);
    sbi_free(&allocator, body);
}
