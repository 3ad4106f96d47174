/* live_build: the body with its next mesh, made beside the present one, and what is carried over to it.
 *
 * All that may fail happens on a body of its own, so that the present one is as it was until the last moment. */
#include "live_private.h"
#include "../fem/assembly_patch.h"
#include "../fem/patch.h"

#include <string.h>

/* ---- a mesh in slots ---- */

static void sbi_live_mesh_layout(const sb_body *body, sbi_live_mesh *mesh, sbi_arena *arena)
{
    size_t nodes = (size_t)mesh->nodes.end, cells = (size_t)mesh->cells.end;
    mesh->positions = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    if (body->fibres)
        mesh->fibres = (sb_vec3 *)sbi_arena_take(arena, cells, sizeof(sb_vec3));
    mesh->shares = (sb_real *)sbi_arena_take(arena, cells, sizeof(sb_real));
    if (mesh->has_pieces)
        mesh->pieces = (sbi_piece *)sbi_arena_take(arena, cells, sizeof(sbi_piece));
    if (mesh->glue_count)
        mesh->glue = (sbi_glue_tie *)sbi_arena_take(arena, (size_t)mesh->glue_count, sizeof(sbi_glue_tie));
    mesh->corners = (int *)sbi_arena_take(arena, cells, (size_t)body->domain.nodes_per_cell * sizeof(int));
    mesh->material = (int *)sbi_arena_take(arena, cells, sizeof(int));
    mesh->inherit = (int *)sbi_arena_take(arena, cells, sizeof(int));
    if (body->domain.cell_patch)
        mesh->patches = (int *)sbi_arena_take(arena, cells, sizeof(int));
    mesh->kept = (unsigned char *)sbi_arena_take(arena, cells, 1);
}

/* The arrays of a mesh whose slots are there. */
static sb_result sbi_live_mesh_take(const sb_body *body, sbi_live_mesh *mesh, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    sbi_live_mesh_layout(body, mesh, &arena);
    mesh->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&body->allocator, arena.used + 1, 1);
    if (!mesh->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a mesh of %d nodes", mesh->nodes.end);
    arena.base = (unsigned char *)mesh->memory;
    arena.used = 0;
    sbi_live_mesh_layout(body, mesh, &arena);
    return SB_OK;
}

SBI_API sb_result sbi_live_mesh_allocate(const sb_body *body, const sbi_slots *nodes, const sbi_slots *cells,
                                         int has_pieces, sbi_live_mesh *mesh, sb_error *error)
{
    memset(mesh, 0, sizeof *mesh);
    mesh->has_pieces = has_pieces;
    if (!sbi_slots_copy(&mesh->nodes, nodes, 0, &body->allocator) ||
        !sbi_slots_copy(&mesh->cells, cells, 0, &body->allocator))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a mesh of %d nodes", nodes->end);
    return sbi_live_mesh_take(body, mesh, error);
}

/* Slots with these counts, and as much room as others have. */
static int sbi_live_slots_like(sbi_slots *slots, const sbi_slots *counts, const sbi_slots *others,
                               const sb_allocator *allocator)
{
    if (!sbi_slots_create(slots, sbi_max_int(counts->fresh, others->capacity), 0, allocator))
        return 0;
    slots->end = counts->end;
    slots->fresh = counts->fresh;
    slots->count = counts->count;
    memset(slots->stack, 0, (size_t)slots->count * sizeof(int));
    return 1;
}

SBI_API sb_result sbi_live_mesh_room(const sb_body *body, const sbi_slots *nodes, const sbi_slots *cells,
                                     int has_pieces, int glue_count, sbi_live_mesh *mesh, sb_error *error)
{
    memset(mesh, 0, sizeof *mesh);
    mesh->has_pieces = has_pieces;
    mesh->glue_count = glue_count;
    if (!sbi_live_slots_like(&mesh->nodes, nodes, &body->live->nodes, &body->allocator) ||
        !sbi_live_slots_like(&mesh->cells, cells, &body->live->cells, &body->allocator))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a mesh of %d nodes", nodes->end);
    return sbi_live_mesh_take(body, mesh, error);
}

SBI_API void sbi_live_mesh_free(const sb_body *body, sbi_live_mesh *mesh)
{
    sbi_slots_free(&mesh->nodes, &body->allocator);
    sbi_slots_free(&mesh->cells, &body->allocator);
    sbi_free(&body->allocator, mesh->memory);
    memset(mesh, 0, sizeof *mesh);
}

SBI_API void sbi_live_mesh_fill(const sb_body *body, sbi_live_mesh *mesh)
{
    size_t n = (size_t)body->domain.nodes_per_cell;
    int nodes = sbi_min_int(mesh->nodes.end, body->domain.node_count);
    int cells = sbi_min_int(mesh->cells.end, body->domain.cell_count);
    memcpy(mesh->positions, body->reference, (size_t)nodes * sizeof(sb_vec3));
    for (int i = 0; i < nodes; i++)
        if (!mesh->nodes.used[i])
            mesh->positions[i] = sb_v3(0, 0, 0);
    memcpy(mesh->corners, body->domain.cells, (size_t)cells * n * sizeof(int));
    memcpy(mesh->material, body->cell_material, (size_t)cells * sizeof(int));
    memcpy(mesh->shares, body->live->shares, (size_t)cells * sizeof(sb_real));
    if (mesh->pieces && body->live->pieces)
        memcpy(mesh->pieces, body->live->pieces, (size_t)cells * sizeof(sbi_piece));
    if (mesh->fibres)
        memcpy(mesh->fibres, body->fibres, (size_t)cells * sizeof(sb_vec3));
    for (int e = 0; e < mesh->cells.end; e++) {
        mesh->kept[e] = e < cells && body->live->cells.used[e];
        mesh->inherit[e] = mesh->kept[e] ? e : -1;
        if (!mesh->kept[e])
            mesh->material[e] = 0;
        if (mesh->patches)
            mesh->patches[e] = mesh->kept[e] ? body->domain.cell_patch[e] : -1;
    }
}

SBI_API sb_result sbi_live_settle_patches(const sb_body *body, sbi_live_mesh *mesh, sb_error *error)
{
    sb_mesh view = sbi_body_mesh_view(body);
    int *memory, *used, *patches, count = 0, made;
    sb_result result;
    if (!mesh->patches)
        return SB_OK;
    memory = (int *)sbi_alloc(&body->allocator, (size_t)mesh->cells.end, 7 * sizeof(int));
    if (!memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the patches of %d elements", mesh->cells.end);
    view.nodes = mesh->positions;
    view.node_count = mesh->nodes.end;
    view.elements = memory;
    view.regions = memory + 4 * (size_t)mesh->cells.end;
    used = view.regions + mesh->cells.end;
    patches = used + mesh->cells.end;
    for (int e = 0; e < mesh->cells.end; e++)
        if (mesh->cells.used[e]) {
            memcpy(view.elements + 4 * (size_t)count, mesh->corners + 4 * (size_t)e, 4 * sizeof(int));
            view.regions[count] = mesh->material[e];
            patches[count] = mesh->patches[e];
            used[count++] = e;
        }
    view.element_count = count;
    result = count ? sbi_patch_follow(&view, &body->allocator, patches, &made, error) : SB_OK;
    for (int k = 0; k < count && result == SB_OK; k++)
        mesh->patches[used[k]] = patches[k];
    sbi_free(&body->allocator, memory);
    return result;
}

/* ---- the next body ---- */

static int sbi_live_patch_count(const sbi_live_mesh *mesh)
{
    int count = 0;
    for (int e = 0; mesh->patches && e < mesh->cells.end; e++)
        count = sbi_max_int(count, mesh->patches[e] + 1);
    return count;
}

static sb_result sbi_live_no_memory(sb_error *error, int nodes)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a changed mesh of %d nodes", nodes);
}

/* Materials, slots and cells of the next body. */
static sb_result sbi_live_copy_make(const sb_body *body, const sbi_live_mesh *mesh, sb_body *next, sb_error *error)
{
    const sb_allocator *allocator = &body->allocator;
    size_t materials = (size_t)body->material_count, cells = (size_t)mesh->cells.end;
    size_t n = (size_t)body->domain.nodes_per_cell, q = (size_t)body->domain.points_per_cell;
    sb_domain *domain = &next->domain;
    sbi_live *live = (sbi_live *)sbi_alloc_zeroed(allocator, 1, sizeof *live);
    next->live = live;
    cells = (size_t)mesh->cells.capacity;
    *domain = body->domain;
    domain->allocator = *allocator;
    domain->cell_mass = NULL;
    domain->cell_patch = mesh->patches ? (int *)sbi_alloc(allocator, cells, sizeof(int)) : NULL;
    domain->patch_count = sbi_live_patch_count(mesh);
    domain->node_count = mesh->nodes.end;
    domain->cell_count = mesh->cells.end;
    domain->cell_capacity = body->live->follows ? mesh->cells.capacity : 0;
    domain->cells = (int *)sbi_alloc(allocator, cells, n * sizeof(int));
    domain->gradients = (sb_real *)sbi_alloc(allocator, cells, q * n * 3 * sizeof(sb_real));
    domain->weights = (sb_real *)sbi_alloc(allocator, cells, q * sizeof(sb_real));
    next->material_regions = (int *)sbi_alloc(allocator, materials, sizeof(int));
    next->materials = (sb_material *)sbi_alloc(allocator, materials, sizeof(sb_material));
    next->twins = (sb_material *)sbi_alloc(allocator, materials, sizeof(sb_material));
    next->made_young = (sb_real *)sbi_alloc(allocator, materials, sizeof(sb_real));
    next->cell_material = (int *)sbi_alloc(allocator, cells, sizeof(int));
    if (mesh->fibres)
        next->fibres = (sb_vec3 *)sbi_alloc_zeroed(allocator, cells, sizeof(sb_vec3));
    if (!live || !domain->cells || !domain->gradients || !domain->weights || !next->material_regions ||
        !next->materials || !next->twins || !next->made_young || !next->cell_material ||
        (mesh->fibres && !next->fibres) || (mesh->patches && !domain->cell_patch) ||
        !sbi_body_copy_regions(next, body) || !sbi_slots_copy(&live->nodes, &mesh->nodes, 0, allocator) ||
        !sbi_slots_copy(&live->cells, &mesh->cells, 0, allocator))
        return sbi_live_no_memory(error, mesh->nodes.end);
    live->shares = (sb_real *)sbi_alloc_zeroed(allocator, (size_t)live->cells.capacity, sizeof(sb_real));
    if (!live->shares || (mesh->pieces && !sbi_live_take_pieces(next)))
        return sbi_live_no_memory(error, mesh->nodes.end);
    live->follows = body->live->follows;
    if (sbi_live_take_marks(next, error) != SB_OK)
        return SB_ERROR_MEMORY;
    cells = (size_t)mesh->cells.end;
    live->rule = body->live->rule;
    live->follows = body->live->follows;
    live->slack = body->live->slack;
    live->version = body->live->version + 1;
    next->node_capacity = live->nodes.capacity;
    next->material_count = body->material_count;
    memcpy(next->material_regions, body->material_regions, materials * sizeof(int));
    memcpy(next->materials, body->materials, materials * sizeof(sb_material));
    memcpy(next->made_young, body->made_young, materials * sizeof(sb_real));
    memcpy(next->cell_material, mesh->material, cells * sizeof(int));
    memcpy(live->shares, mesh->shares, cells * sizeof(sb_real));
    for (size_t e = 0; mesh->pieces && e < cells; e++) {
        live->pieces[e] = mesh->pieces[e];
        live->piece_count += mesh->pieces[e].is != 0;
    }
    memcpy(domain->cells, mesh->corners, cells * n * sizeof(int));
    if (mesh->patches)
        memcpy(domain->cell_patch, mesh->patches, cells * sizeof(int));
    if (mesh->fibres)
        memcpy(next->fibres, mesh->fibres, cells * sizeof(sb_vec3));
    if (body->live->glue.capacity || mesh->glue_count) {
        sb_result result =
            sbi_live_take_glue_room(next, sbi_max_int(body->live->glue.capacity, mesh->glue_count), error);
        if (result != SB_OK)
            return result;
        sbi_live_copy_glue(&live->glue, mesh->glue, mesh->glue_count, domain->cells);
    }
    return sbi_domain_fill(domain, live->rule, mesh->positions, mesh->shares, mesh->pieces, error);
}

/* Part of each cell in its slot, -1 where it is free, from those of the cells in use. */
static int sbi_live_spread_parts(sb_body *next, const int *used)
{
    int *parts = next->element_component.items, cells = next->domain.cell_count;
    int *spread = (int *)sbi_alloc(&next->allocator, (size_t)cells, sizeof(int));
    if (!spread)
        return 0;
    for (int e = 0; e < cells; e++)
        spread[e] = -1;
    for (int k = 0; k < next->element_component.rows; k++)
        spread[used[k]] = parts[k];
    sbi_free(&next->allocator, parts);
    next->element_component.items = spread;
    next->element_component.rows = cells;
    return 1;
}

/* Cells of each node and parts, in the numbers of the slots, made of the cells in use. */
static sb_result sbi_live_make_lists(const sbi_live_mesh *mesh, sb_body *next, sb_error *error)
{
    sb_mesh view = sbi_body_mesh_view(next);
    int n = next->domain.nodes_per_cell, count = 0, *used;
    sb_result result;
    used = (int *)sbi_alloc(&next->allocator, (size_t)next->domain.cell_count, (size_t)(n + 1) * sizeof(int));
    if (!used)
        return sbi_live_no_memory(error, view.node_count);
    view.nodes = mesh->positions;
    view.elements = used + next->domain.cell_count;
    for (int e = 0; e < next->domain.cell_count; e++)
        if (sbi_live_has_cell(next, e)) {
            memcpy(view.elements + (size_t)count * (size_t)n, next->domain.cells + (size_t)e * (size_t)n,
                   (size_t)n * sizeof(int));
            used[count++] = e;
        }
    view.element_count = count;
    result = sb_mesh_node_elements(&view, &next->allocator, &next->node_elements, error);
    for (int k = 0; result == SB_OK && k < next->node_elements.offsets[view.node_count]; k++)
        next->node_elements.items[k] = used[next->node_elements.items[k]];
    if (result == SB_OK)
        result = sb_mesh_components(&view, &next->allocator, &next->element_component, &next->component_count, error);
    if (result == SB_OK && !sbi_live_spread_parts(next, used))
        result = sbi_live_no_memory(error, view.node_count);
    if (result == SB_OK && !next->live->follows) /* there are no more parts than cells */
        sbi_live_join_glued(next, used);
    sbi_free(&next->allocator, used);
    return result;
}

/* Matrix, arrays, preconditioner and the rest that a body at rest has. */
static sb_result sbi_live_make_rest(const sb_body *body, const sbi_live_mesh *mesh, sb_body *next, sb_error *error)
{
    const sb_domain *domain = &next->domain;
    sb_result result = sbi_live_make_lists(mesh, next, error);
    if (result == SB_OK)
        result = sbi_patches_create(domain, &next->allocator, &next->assembly.patches, error);
    if (result == SB_OK)
        result = sbi_body_make_matrix(next, 0, NULL, NULL, &next->matrix, error);
    if (result == SB_OK)
        result = sbi_body_take_nodes(next, error);
    next->assembly.chunk_size = body->live->follows ? body->assembly.chunk_size : 0;
    if (result == SB_OK)
        result = sbi_body_take_topology(next, error);
    if (result != SB_OK)
        return result;
    memcpy(next->reference, mesh->positions, (size_t)domain->node_count * sizeof(sb_vec3));
    result = sbi_body_prepare_assembly(next, error);
    if (result != SB_OK)
        return result;
    if (body->kept && !sbi_kept_take(next))
        return sbi_live_no_memory(error, domain->node_count);
    if (next->kept)
        next->kept->angle = body->kept->angle;
    sbi_body_label_nodes(next);
    result = sbi_body_remake_preconditioner(next, body->precond, error);
    if (result == SB_OK)
        result = sb_pcg_workspace_create(next->node_capacity, &next->allocator, &next->pcg, error);
    if (result == SB_OK)
        result = sbi_pcg_keep_guest_room(&next->pcg, &body->pcg, next->node_capacity, body->node_capacity, error);
    next->pcg.row_count = domain->node_count;
    if (result == SB_OK && body->assembly.terms)
        result = sbi_assembly_reserve_memory(&next->assembly, body->assembly.terms, &next->allocator, error);
    if (result == SB_OK && body->damping_blocks)
        result = sbi_body_reserve_damping(next, next->materials, next->material_count, error);
    if (result != SB_OK)
        return result;
    if (body->live->follows)
        result = sbi_matrix_reserve_plan(&next->matrix, sbi_max_int(1, body->matrix.live->key_capacity / 3 * 2),
                                         error); /* it takes half as many again */
    if (result == SB_OK && body->live->follows)
        result = sbi_assembly_reserve_parents(&next->assembly,
                                              sbi_max_int(1, body->assembly.live->inherited_capacity / 2), error);
    if (result != SB_OK)
        return result;
    result = sbi_live_make_slivers(next, error);
    if (result != SB_OK)
        return result;
    next->assembly.fibres = next->fibres;
    next->assembly.fold_fallback = body->assembly.fold_fallback;
    sbi_body_materials_changed(next);
    sb_body_reset(next);
    return SB_OK;
}

SBI_API sb_result sbi_live_build(const sb_body *body, const sbi_live_mesh *mesh, sb_body **next, sb_error *error)
{
    sb_body *made = (sb_body *)sbi_alloc_zeroed(&body->allocator, 1, sizeof *made);
    sb_result result;
    if (!made)
        return sbi_live_no_memory(error, mesh->nodes.end);
    made->allocator = body->allocator;
    made->jobs = body->jobs;
    made->clock = body->clock;
    made->mass_kind = body->mass_kind;
    made->integrator = body->integrator;
    made->gravity = body->gravity;
    made->damping_mass = body->damping_mass;
    made->damping_stiffness = body->damping_stiffness;
    made->tolerance = body->tolerance;
    made->newton_tolerance = body->newton_tolerance;
    made->max_iterations = body->max_iterations;
    made->max_newton = body->max_newton;
    made->auto_solver = body->auto_solver;
    made->spectral_radius = body->spectral_radius;
    made->max_substeps = body->max_substeps;
    result = sbi_live_copy_make(body, mesh, made, error);
    if (result == SB_OK)
        result = sbi_live_make_rest(body, mesh, made, error);
    if (result != SB_OK) {
        sbi_body_release(made);
        return result;
    }
    *next = made;
    return SB_OK;
}

/* ---- motion, supports, dead loads ---- */

SBI_API void sbi_live_list_carried(const sb_body *body, sb_vec3 *vectors[SBI_LIVE_CARRIED])
{
    sb_vec3 *list[SBI_LIVE_CARRIED] = {body->displacement, body->velocity,     body->acceleration, body->target,
                                       body->dead_load,    body->equilibrated, body->external,     body->reaction};
    memcpy(vectors, list, sizeof list);
}

/* Sources of one node. */
typedef struct sbi_live_sources {
    int count;
    const int *nodes;
    const sb_real *weights;
} sbi_live_sources;

static sbi_live_sources sbi_live_get_sources(const int *start, int index, const int *nodes, const sb_real *weights)
{
    sbi_live_sources sources;
    sources.count = start[index + 1] - start[index];
    sources.nodes = nodes + start[index];
    sources.weights = weights + start[index];
    return sources;
}

/* The weighted sum of at least one source. */
static sb_vec3 sbi_live_interpolate(const sbi_live_sources *sources, const sb_vec3 *values)
{
    sb_vec3 sum = sb_v3(0, 0, 0), first = values[sources->nodes[0]];
    /* from the first source, so that what is the same for all stays the same to the last bit */
    for (int k = 1; k < sources->count; k++)
        sum = sb_v3_madd(sum, sources->weights[k], sb_v3_sub(values[sources->nodes[k]], first));
    return sb_v3_add(first, sum);
}

/* The axes along which all sources are supported; nodes without a cell are held for another reason. */
static unsigned sbi_live_common_axes(const sb_body *body, const sbi_live_sources *sources)
{
    unsigned axes = SB_XYZ;
    for (int k = 0; k < sources->count; k++)
        axes &= body->node_component[sources->nodes[k]] < 0 ? 0u : (unsigned)body->fixed[sources->nodes[k]];
    return axes;
}

/* The axes along which a node with these options may have the supports of its sources. */
static unsigned sbi_live_kept_axes(unsigned options)
{
    unsigned axes = (options & SB_NODE_KEEP_X ? (unsigned)SB_X : 0u) |
                    (options & SB_NODE_KEEP_Y ? (unsigned)SB_Y : 0u) | (options & SB_NODE_KEEP_Z ? (unsigned)SB_Z : 0u);
    return options & SB_NODE_COPY ? axes : (unsigned)SB_XYZ;
}

/* A node made: motion of its sources, and their supports as far as its options say. */
SBI_API sbi_live_motion sbi_live_made_motion(const sb_body *body, const sbi_mesh_change *change, int index)
{
    sbi_live_sources sources =
        sbi_live_get_sources(change->source_start, index, change->sources, change->source_weights);
    sbi_live_motion motion;
    motion.node = change->made_nodes[index];
    motion.fixed =
        (unsigned char)(sbi_live_kept_axes(change->made_copies[index]) & sbi_live_common_axes(body, &sources));
    motion.displacement = sbi_live_interpolate(&sources, body->displacement);
    motion.velocity = sbi_live_interpolate(&sources, body->velocity);
    motion.acceleration = sbi_live_interpolate(&sources, body->acceleration);
    motion.target = motion.fixed ? sbi_live_interpolate(&sources, body->target) : sb_v3(0, 0, 0);
    return motion;
}

/* The components of b along the axes, and those of a along the others. */
static sb_vec3 sbi_live_select(unsigned axes, sb_vec3 a, sb_vec3 b)
{
    return sb_v3(axes & SB_X ? b.x : a.x, axes & SB_Y ? b.y : a.y, axes & SB_Z ? b.z : a.z);
}

/* A node moved with sources: their motion but along axes that it alone is held along, and targets where all have
 * some. */
SBI_API sbi_live_motion sbi_live_moved_motion(const sb_body *body, const sbi_mesh_change *change, int index)
{
    sbi_live_sources sources =
        sbi_live_get_sources(change->moved_start, index, change->moved_sources, change->moved_weights);
    int node = change->moved_nodes[index];
    unsigned held = body->node_component[node] < 0 ? 0u : (unsigned)body->fixed[node], both, free;
    sbi_live_motion motion;
    memset(&motion, 0, sizeof motion);
    motion.node = sources.count ? node : -1;
    if (!sources.count)
        return motion;
    both = held & sbi_live_common_axes(body, &sources);
    free = SB_XYZ & (~held | both);
    motion.fixed = (unsigned char)held;
    motion.displacement =
        sbi_live_select(free, body->displacement[node], sbi_live_interpolate(&sources, body->displacement));
    motion.velocity = sbi_live_select(free, body->velocity[node], sbi_live_interpolate(&sources, body->velocity));
    motion.acceleration =
        sbi_live_select(free, body->acceleration[node], sbi_live_interpolate(&sources, body->acceleration));
    motion.target = sbi_live_select(both, body->target[node], sbi_live_interpolate(&sources, body->target));
    return motion;
}

static void sbi_live_set_motion(sb_body *next, const sbi_live_motion *motion)
{
    if (motion->node < 0)
        return;
    next->displacement[motion->node] = motion->displacement;
    next->velocity[motion->node] = motion->velocity;
    next->acceleration[motion->node] = motion->acceleration;
    next->target[motion->node] = motion->target;
    next->fixed[motion->node] = (unsigned char)(next->node_component[motion->node] < 0 ? (int)SB_XYZ : motion->fixed);
}

/* Nodes that stay keep all; made ones follow their sources; forces on removed ones go to their heirs. */
static void sbi_live_carry_nodes(const sb_body *body, const sbi_mesh_change *change, sb_body *next)
{
    sb_vec3 *from[SBI_LIVE_CARRIED], *to[SBI_LIVE_CARRIED];
    int both = sbi_min_int(body->domain.node_count, next->domain.node_count);
    sbi_live_list_carried(body, from);
    sbi_live_list_carried(next, to);
    for (int k = 0; k < SBI_LIVE_CARRIED; k++)
        memcpy(to[k], from[k], (size_t)both * sizeof(sb_vec3));
    for (int i = 0; i < both; i++)
        if (next->node_component[i] >= 0)
            next->fixed[i] = (unsigned char)(body->node_component[i] >= 0 ? body->fixed[i] : 0);
    for (int i = 0; i < change->removed_node_count; i++)
        for (int k = 0; k < SBI_LIVE_CARRIED && change->removed_nodes[i] < next->domain.node_count; k++)
            to[k][change->removed_nodes[i]] = sb_v3(0, 0, 0);
    for (int i = 0; i < change->made_node_count; i++)
        for (int k = 0; k < SBI_LIVE_CARRIED; k++)
            to[k][change->made_nodes[i]] = sb_v3(0, 0, 0);
    for (int i = 0; i < change->made_node_count; i++) {
        sbi_live_motion motion = sbi_live_made_motion(body, change, i);
        sbi_live_set_motion(next, &motion);
    }
    for (int i = 0; i < change->moved_node_count; i++) {
        sbi_live_motion motion = sbi_live_moved_motion(body, change, i);
        sbi_live_set_motion(next, &motion);
    }
    for (int i = 0; i < change->removed_node_count; i++)
        for (int k = change->heir_start[i]; k < change->heir_start[i + 1]; k++) {
            sb_vec3 force = body->dead_load[change->removed_nodes[i]];
            sb_vec3 *load = next->dead_load + change->heirs[k];
            if (force.x != 0 || force.y != 0 || force.z != 0)
                *load = sb_v3_madd(*load, change->heir_weights[k], force);
        }
    for (int i = 0; i < next->domain.node_count; i++)
        sbi_live_park_node(next, i, i < both && body->node_component[i] >= 0);
    sbi_body_update_positions(next);
}

/* Rotations and memory by cell. */
static void sbi_live_carry_cells(const sb_body *body, const sbi_live_mesh *mesh, sb_body *next)
{
    for (int e = 0; e < mesh->cells.end; e++)
        if (mesh->inherit[e] >= 0)
            sbi_assembly_copy_cell(&next->assembly, e, &body->assembly, mesh->inherit[e]);
        else if (mesh->cells.used[e])
            sbi_assembly_forget_cell(&next->assembly, e, next->displacement);
    sbi_assembly_begin_step(&next->assembly, 0);
}

/* ---- all of it ---- */

SBI_API sb_result sbi_live_refuse_lonely(int node, int made, sb_error *error)
{
    return sbi_fail_node(error, SB_ERROR_MESH, node,
                         made ? "the new node %d is in no cell" : "node %d is left without a cell: remove it, too",
                         node);
}

/* Every node in use has a cell, but those that had none before, unless the change may leave nodes alone. */
static sb_result sbi_live_check_lonely(const sb_body *body, const sbi_mesh_change *change, const sb_body *next,
                                       sb_error *error)
{
    if (body->live->erodes)
        return SB_OK;
    for (int i = 0; i < change->made_node_count; i++)
        if (sbi_live_first_cell(next, change->made_nodes[i]) < 0)
            return sbi_live_refuse_lonely(change->made_nodes[i], 1, error);
    for (int i = 0; i < sbi_min_int(body->domain.node_count, next->domain.node_count); i++)
        if (next->live->nodes.used[i] && sbi_live_first_cell(body, i) >= 0 && sbi_live_first_cell(next, i) < 0)
            return sbi_live_refuse_lonely(i, 0, error);
    return SB_OK;
}

/* Blocks for the rows of supports. */
static sb_result sbi_live_reserve_supports(sb_body *next, sb_error *error)
{
    int needed = 0;
    for (int i = 0; i < next->domain.node_count; i++)
        if (next->fixed[i] && next->node_component[i] >= 0)
            needed += next->matrix.row_end[i] - next->matrix.row_start[i];
    if (sbi_body_reserve_support_blocks(next, needed) != SB_OK)
        return sbi_live_no_memory(error, next->domain.node_count);
    next->support_used = needed;
    return SB_OK;
}

SBI_API sb_result sbi_live_carry(const sb_body *body, const sbi_mesh_change *change, const sbi_live_mesh *mesh,
                                 sb_body *next, sb_error *error)
{
    sb_result result = sbi_live_check_lonely(body, change, next, error);
    if (result != SB_OK)
        return result;
    sbi_live_carry_nodes(body, change, next);
    sbi_live_carry_cells(body, mesh, next);
    result = sbi_live_reserve_supports(next, error);
    if (result == SB_OK)
        result = sbi_live_carry_rows(body, change, next, error);
    if (result != SB_OK)
        return result;
    next->acceleration_known = body->acceleration_known;
    next->acceleration_step = body->acceleration_step;
    next->assembly.fold_fallback = body->assembly.fold_fallback;
    sbi_precond_set_memory(next->precond, sbi_precond_get_memory(body->precond));
    sbi_live_carry_momentum(body, change, next);
    return SB_OK;
}

/* Members that point into the struct. */
static void sbi_live_rebase(sb_body *body)
{
    body->assembly.domain = &body->domain;
    body->assembly.jobs = &body->jobs;
}

SBI_API void sbi_live_replace(sb_body *body, sb_body *next)
{
    sb_body old = *body;
    sbi_live *live = body->live, *made = next->live;
    if (next->node_capacity == body->node_capacity) { /* pointers that others hold stay valid */
        sbi_body_copy_nodes(body, next);
        sbi_body_swap_nodes(body, next);
        old = *body;
    }
    *body = *next;
    *next = old;
    body->observe = old.observe;
    body->observer = old.observer;
    next->observe = NULL;
    made->spare = live->spare;
    made->lists = live->lists;
    made->list_bytes = live->list_bytes;
    live->spare = NULL;
    live->lists = NULL;
    body->parts = old.parts;
    next->parts = NULL;
    next->rigids = body->rigids;
    body->rigids = old.rigids;
    body->touch = old.touch;
    body->touch_keeper = old.touch_keeper;
    body->substep_room = old.substep_room;
    body->substep_room_size = old.substep_room_size;
    next->touch = NULL;
    next->substep_room = NULL;
    sbi_free(&next->allocator, made->pushes);
    made->pushes = live->pushes;
    made->push_count = live->push_count;
    made->push_capacity = live->push_capacity;
    live->pushes = NULL;
    made->open = live->open;
    made->rebuilds = live->rebuilds;
    made->listeners = live->listeners;
    made->listener_count = live->listener_count;
    made->listener_capacity = live->listener_capacity;
    made->last_listener = live->last_listener;
    made->find = live->find;
    made->holder = live->holder;
    made->find_user = live->find_user;
    made->uncut = live->uncut;
    live->open = NULL;
    live->listeners = NULL;
    live->listener_count = 0;
    body->pattern_version = old.pattern_version + 1;
    sbi_live_rebase(body);
    sbi_live_rebase(next);
    sbi_body_release(next);
}
