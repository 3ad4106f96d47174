/* live_slots: slots of nodes and cells, and what a body with slack has besides them. */
#include "live_change.h"
#include "live_private.h"
#include "rigid_private.h"

#include <string.h>

/* ---- slots ---- */

SBI_API int sbi_slots_create(sbi_slots *slots, int capacity, int used, const sb_allocator *allocator)
{
    memset(slots, 0, sizeof *slots);
    slots->stack = (int *)sbi_alloc(allocator, (size_t)capacity + 1, sizeof(int));
    slots->used = (unsigned char *)sbi_alloc_zeroed(allocator, (size_t)capacity + 1, 1);
    if (!slots->stack || !slots->used) {
        sbi_slots_free(slots, allocator);
        return 0;
    }
    slots->capacity = capacity;
    slots->end = slots->fresh = used;
    memset(slots->used, 1, (size_t)used);
    return 1;
}

SBI_API void sbi_slots_assign(sbi_slots *to, const sbi_slots *from)
{
    to->end = from->end;
    to->fresh = from->fresh;
    to->count = from->count;
    memcpy(to->stack, from->stack, (size_t)from->count * sizeof(int));
    memcpy(to->used, from->used, (size_t)from->capacity);
}

SBI_API int sbi_slots_copy(sbi_slots *to, const sbi_slots *from, int capacity, const sb_allocator *allocator)
{
    if (!sbi_slots_create(to, sbi_max_int(capacity, from->capacity), 0, allocator))
        return 0;
    sbi_slots_assign(to, from);
    return 1;
}

SBI_API void sbi_slots_free(sbi_slots *slots, const sb_allocator *allocator)
{
    sbi_free(allocator, slots->stack);
    sbi_free(allocator, slots->used);
    memset(slots, 0, sizeof *slots);
}

SBI_API int sbi_slots_is_used(const sbi_slots *slots, int slot)
{
    return slot >= 0 && slot < slots->end && slots->used[slot];
}

SBI_API int sbi_slots_take(sbi_slots *slots)
{
    int slot;
    if (slots->count == 0 && slots->fresh == slots->capacity)
        return -1;
    slot = slots->count ? slots->stack[--slots->count] : slots->fresh++;
    slots->used[slot] = 1;
    slots->end = sbi_max_int(slots->end, slot + 1);
    return slot;
}

SBI_API void sbi_slots_give(sbi_slots *slots, int slot)
{
    int merged = 0;
    slots->used[slot] = 0;
    slots->stack[slots->count++] = slot;
    while (slots->end > 0 && !slots->used[slots->end - 1])
        slots->end--;
    while (merged < slots->count && slots->stack[merged] == slots->fresh - 1) {
        slots->fresh--;
        merged++;
    }
    slots->count -= merged;
    if (merged)
        memmove(slots->stack, slots->stack + merged, (size_t)slots->count * sizeof(int));
}

/* ---- what a body has of it ---- */

/* count and a share of it more; -1: too many. */
static int sbi_live_with_slack(int count, sb_real slack)
{
    double most = (double)count + (double)slack * (double)count + 1;
    return most < (double)(INT32_MAX / 8) ? (int)most : -1;
}

/* Slack of a matrix with as much room for rows as the body has for nodes. */
static double sbi_live_matrix_slack(const sb_body *body, const sb_matrix *matrix)
{
    double slack = (double)body->node_capacity / (double)matrix->row_count - 1 + 1e-6;
    return slack > body->live->slack ? slack : body->live->slack;
}

/* Room for more cells in what is there already. */
static sb_result sbi_live_take_cells(sb_body *body, sb_error *error)
{
    int capacity = body->live->cells.capacity, *material;
    sb_result result = SB_OK;
    if (body->live->follows)
        result = sbi_domain_make_live(&body->domain, capacity, error);
    if (result != SB_OK)
        return result;
    material = (int *)sbi_alloc_zeroed(&body->allocator, (size_t)capacity, sizeof(int));
    if (!material)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d cells", capacity);
    memcpy(material, body->cell_material, (size_t)body->domain.cell_count * sizeof(int));
    sbi_free(&body->allocator, body->cell_material);
    body->cell_material = material;
    return sbi_live_make_matrix(body, &body->matrix, error);
}

SBI_API sb_result sbi_live_create(sb_body *body, const sb_body_def *def, sb_error *error)
{
    const sb_allocator *allocator = &body->allocator;
    int nodes = body->domain.node_count, cells = body->domain.cell_count;
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    int node_capacity = sbi_live_with_slack(nodes, def->slack), cell_capacity = sbi_live_with_slack(cells, def->slack);
    sbi_live *live;
    sb_result result;
    body->node_capacity = nodes;
    if (def->slack == 0)
        return SB_OK;
    if (def->domain)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "def.slack does not go with def.domain: where points of new cells "
                        "would be is unknown");
    if (def->level_count > 0)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "def.slack does not go with def.levels: they fit the mesh of creation only");
    live = node_capacity < 0 || cell_capacity < 0 ? NULL : (sbi_live *)sbi_alloc_zeroed(allocator, 1, sizeof *live);
    body->live = live;
    if (!live || !sbi_slots_create(&live->nodes, node_capacity, nodes, allocator) ||
        !sbi_slots_create(&live->cells, cell_capacity, cells, allocator))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d nodes and %g as much in reserve", nodes,
                        (double)def->slack);
    live->shares = (sb_real *)sbi_alloc_zeroed(allocator, (size_t)cell_capacity, sizeof(sb_real));
    if (!live->shares)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d cells", cell_capacity);
    for (int e = 0; e < cells; e++)
        live->shares[e] = 1;
    live->rule = sbi_body_points(body) == sbi_element_quadrature(sbi_domain_element(&body->domain),
                                                                 SB_QUADRATURE_STIFFNESS, points, weights)
                     ? SB_QUADRATURE_STIFFNESS
                     : SB_QUADRATURE_STIFFNESS_CURVED;
    body->node_capacity = node_capacity;
    live->slack = (double)def->slack;
    live->follows = body->domain.element_type == SB_TET4 && body->domain.points_per_cell == 1 &&
                    !body->domain.cell_mass && !body->domain.cell_patch;
    result = sbi_live_take_marks(body, error);
    return result == SB_OK ? sbi_live_take_cells(body, error) : result;
}

SBI_API void sbi_live_free(sb_body *body)
{
    sbi_live *live = body->live;
    if (!live)
        return;
    sbi_free(&body->allocator, live->lists);
    sbi_free(&body->allocator, live->masses);
    sbi_free(&body->allocator, live->node_marks);
    sbi_free(&body->allocator, live->cell_marks);
    sbi_slots_free(&live->nodes, &body->allocator);
    sbi_slots_free(&live->cells, &body->allocator);
    sbi_free(&body->allocator, live->shares);
    sbi_free(&body->allocator, live->pieces);
    sbi_free(&body->allocator, live->slivers.memory);
    sbi_free(&body->allocator, live->glue.ties);
    sbi_free(&body->allocator, live->next_glue.ties);
    sbi_free(&body->allocator, live->couplings);
    sbi_free(&body->allocator, live->pushes);
    sbi_free(&body->allocator, live->listeners);
    sbi_free(&body->allocator, live);
    body->live = NULL;
}

SBI_API sb_result sbi_live_take_marks(sb_body *body, sb_error *error)
{
    sbi_live *live = body->live;
    const sb_allocator *allocator = &body->allocator;
    size_t nodes = (size_t)live->nodes.capacity, cells = (size_t)live->cells.capacity;
    live->node_marks = (int *)sbi_alloc_zeroed(allocator, nodes, sizeof(int));
    live->cell_marks = (unsigned char *)sbi_alloc_zeroed(allocator, cells, 1);
    if (live->follows)
        live->masses = (sb_real(*)[2])sbi_alloc_zeroed(allocator, cells, 4 * sizeof *live->masses);
    return live->node_marks && live->cell_marks && (live->masses || !live->follows)
               ? SB_OK
               : sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d cells that may change", live->cells.capacity);
}

/* ---- pieces ---- */

SBI_API sb_result sbi_live_check_pieces(const sb_body *body, sb_error *error)
{
    const sb_domain *domain = &body->domain;
    int is_tet4 = domain->element_type == SB_TET4, is_tet10 = domain->element_type == SB_TET10;
    if ((!is_tet4 && !is_tet10) || (is_tet10 && sbi_body_points(body) != 4))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "pieces of elements are of tet4, or of tet10 with 4 points each, not of %s with %d",
                        sb_element_name(domain->element_type), sbi_body_points(body));
    if (is_tet10 && body->mass_kind == SB_MASS_CONSISTENT)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "consistent masses of pieces of tet10 take more than their moments: lumped ones do not");
    return SB_OK;
}

SBI_API int sbi_live_take_pieces(sb_body *body)
{
    sbi_live *live = body->live;
    if (!live->pieces)
        live->pieces =
            (sbi_piece *)sbi_alloc_zeroed(&body->allocator, (size_t)live->cells.capacity, sizeof *live->pieces);
    return live->pieces != NULL;
}

SBI_API void sbi_live_drop_pieces(sb_body *body)
{
    if (body->live->piece_count)
        return;
    sbi_free(&body->allocator, body->live->pieces);
    body->live->pieces = NULL;
}

SBI_API void sbi_live_park_node(sb_body *body, int node, int had)
{
    if (body->node_component[node] >= 0 || (!had && sbi_live_first_cell(body, node) < 0))
        return;
    body->target[node] = body->displacement[node];
    body->velocity[node] = body->acceleration[node] = sb_v3(0, 0, 0);
}

/* Couples what glue ties. */
static sb_result sbi_live_couple_glue(const sb_body *body, sb_matrix *matrix, sb_error *error)
{
    sbi_matrix_couplings couplings;
    sb_result result;
    memset(&couplings, 0, sizeof couplings);
    couplings.made_count = sbi_live_list_couplings(&body->live->glue, body->live->couplings, 0);
    couplings.made = couplings.made_count ? body->live->couplings[0] : NULL;
    if (!couplings.made_count)
        return SB_OK;
    result = sbi_matrix_reserve(matrix, NULL, &couplings, error);
    if (result == SB_OK)
        sbi_matrix_follow(matrix, NULL);
    return result;
}

SBI_API sb_result sbi_live_make_matrix(const sb_body *body, sb_matrix *matrix, sb_error *error)
{
    sb_result result;
    if (!sbi_live_follows(body))
        return SB_OK;
    result = sbi_matrix_make_live(matrix, body->domain.cell_count, 4, body->domain.cells, NULL, body->live->nodes.used,
                                  sbi_live_matrix_slack(body, matrix), error);
    return result == SB_OK ? sbi_live_couple_glue(body, matrix, error) : result;
}

SBI_API sb_result sbi_live_make_assembly(sb_body *body, sb_error *error)
{
    sb_result result;
    if (body->live)
        body->assembly.glue = &body->live->glue;
    if (!sbi_live_follows(body))
        return SB_OK;
    result = sbi_assembly_make_live(&body->assembly, &body->matrix, &body->allocator, error);
    if (result == SB_OK)
        sb_index_lists_free(&body->node_elements); /* rings take their place */
    return result;
}

SBI_API void sbi_live_label_nodes(sb_body *body)
{
    const sb_matrix *matrix = &body->matrix;
    int lonely = -1; /* the part of all nodes that are coupled with no other */
    for (int i = 0; i < matrix->row_count && lonely < 0; i++)
        if (sbi_live_first_cell(body, i) < 0)
            lonely = matrix->live->part_of[i];
    body->component_count = matrix->part_count - (lonely >= 0);
    for (int i = 0; i < matrix->row_count; i++) {
        int part = matrix->live->part_of[i];
        int is_free = part == lonely || !sbi_live_has_material(body, i);
        body->node_component[i] = is_free ? -1 : part - (lonely >= 0 && part > lonely);
    }
}

/* ---- what every change asks ---- */

SBI_API sb_result sbi_live_ask_listeners(const sb_body *body, const sb_mesh_change *change, sb_error *error)
{
    const sbi_live *live = body->live;
    sb_result refused = sbi_rigids_reserve(body, change, error);
    if (refused != SB_OK)
        return refused;
    for (int i = 0; i < live->listener_count; i++) {
        const sb_body_listener *calls = &live->listeners[i].calls;
        sb_result result = calls->reserve ? calls->reserve(calls->user, body, change, error) : SB_OK;
        for (int k = 0; k < i && result != SB_OK; k++)
            if (live->listeners[k].calls.give_up)
                live->listeners[k].calls.give_up(live->listeners[k].calls.user);
        if (result != SB_OK)
            return result;
    }
    return SB_OK;
}

SBI_API sb_result sbi_live_check_removed(const sb_body *body, const sbi_slots *nodes, const sb_mesh_change *change,
                                         sb_error *error)
{
    for (int i = 0; i < change->removed_node_count; i++) {
        int node = change->removed_nodes[i], heirs = change->heir_start[i + 1] - change->heir_start[i];
        for (int k = change->heir_start[i]; k < change->heir_start[i + 1]; k++)
            if (!sbi_slots_is_used(nodes, change->heirs[k]))
                return sbi_fail_node(error, SB_ERROR_INDEX, change->heirs[k],
                                     "node %d, the heir of node %d, is not in use after the change", change->heirs[k],
                                     node);
        if (!heirs && body->fixed[node] && body->node_component[node] >= 0)
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, node,
                                 "node %d is supported and has no heir: release it before it is removed", node);
    }
    return SB_OK;
}
