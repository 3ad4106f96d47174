/* live_glue: what ties pieces of one element to each other while a cut has not come through it.
 *
 * Ties are of pairs of cells and stand on whatever nodes these have. They are a part of what the cells hold (internal
 * force, tangent, elastic energy), and the nodes that they tie are coupled in the matrix besides those of cells. */
#include "live_change.h"

#include <string.h>

/* Couplings of a tie, at most, of a body that follows changes in place. */
enum { SBI_GLUE_FOLLOWS = 4, SBI_GLUE_PAIRS = SBI_GLUE_FOLLOWS * SBI_GLUE_FOLLOWS };

/* An array with room for so many ties in place of the one there; 0: no memory. */
static int sbi_live_grow_ties(const sb_body *body, sbi_glue *glue, int capacity)
{
    const sb_allocator *allocator = &body->allocator;
    sbi_glue_tie *ties = (sbi_glue_tie *)sbi_alloc(allocator, (size_t)capacity, sizeof *ties);
    if (!ties)
        return 0;
    glue->nodes = body->domain.nodes_per_cell;
    if (glue->count)
        memcpy(ties, glue->ties, (size_t)glue->count * sizeof *ties);
    sbi_free(allocator, glue->ties);
    glue->ties = ties;
    glue->capacity = capacity;
    return 1;
}

SBI_API sb_result sbi_live_take_glue_room(sb_body *body, int count, sb_error *error)
{
    sbi_live *live = body->live;
    int capacity = count;
    int(*couplings)[2] = NULL;
    if (count <= live->glue.capacity && count <= live->next_glue.capacity)
        return SB_OK;
    if (capacity > INT32_MAX / (8 * SBI_GLUE_PAIRS))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d ties", count);
    if (live->follows)
        couplings = (int(*)[2])sbi_alloc(&body->allocator, 2 * (size_t)capacity, SBI_GLUE_PAIRS * sizeof *couplings);
    if ((live->follows && !couplings) || !sbi_live_grow_ties(body, &live->next_glue, capacity) ||
        !sbi_live_grow_ties(body, &live->glue, capacity)) {
        sbi_free(&body->allocator, couplings);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d ties", count);
    }
    sbi_free(&body->allocator, live->couplings);
    live->couplings = couplings;
    return SB_OK;
}

SBI_API sb_result sbi_live_reserve_glue(sb_body *body, int count, sb_error *error)
{
    int64_t roomy = (int64_t)count + count / 2 + 16;
    if (count <= sbi_min_int(body->live->glue.capacity, body->live->next_glue.capacity))
        return SB_OK;
    return sbi_live_take_glue_room(body, roomy < INT32_MAX ? (int)roomy : INT32_MAX, error);
}

SBI_API void sbi_live_copy_glue(sbi_glue *glue, const sbi_glue_tie *ties, int count, const int *corners)
{
    glue->count = count;
    for (int k = 0; k < count; k++) {
        glue->ties[k] = ties[k];
        for (int side = 0; side < 2; side++)
            memcpy(glue->ties[k].nodes[side], corners + (size_t)glue->nodes * (size_t)ties[k].cells[side],
                   (size_t)glue->nodes * sizeof(int));
    }
}

/* ---- a change ---- */

/* Nodes of a cell after a change. */
static const int *sbi_live_next_nodes(const sb_body_change *change, int cell)
{
    int at = change->cell_at[cell];
    if (at && !change->made_cells.items[at - 1].dropped)
        return change->corners.items + change->made_cells.items[at - 1].first;
    return change->body->domain.cells + (size_t)change->body->domain.nodes_per_cell * (size_t)cell;
}

/* 1 when a change of others takes a tie with it: one of its cells goes, or of its nodes moves in the material, so that
 * it would tie points that are no longer one. */
static int sbi_live_tie_goes(const sb_body_change *change, const sbi_glue_tie *tie)
{
    int goes = 0;
    for (int i = 0; i < change->removed_cells.count; i++)
        goes |= change->removed_cells.items[i] == tie->cells[0] || change->removed_cells.items[i] == tie->cells[1];
    for (int i = 0; i < change->moved_nodes.count; i++)
        for (int a = 0; a < change->body->domain.nodes_per_cell; a++)
            goes |= change->moved_nodes.items[i].node == tie->nodes[0][a] ||
                    change->moved_nodes.items[i].node == tie->nodes[1][a];
    return goes;
}

SBI_API sb_result sbi_live_make_next_glue(const sb_body_change *change, sb_error *error)
{
    sbi_live *live = change->body->live;
    const sbi_glue_tie *ties = change->glue ? change->glue : live->glue.ties;
    int count = change->glue ? change->glue_count : live->glue.count;
    sb_result result = sbi_live_reserve_glue(change->body, count, error);
    live->next_glue.count = 0;
    if (result != SB_OK)
        return result;
    ties = change->glue ? change->glue : live->glue.ties;
    for (int k = 0; k < count; k++) {
        sbi_glue_tie *tie = live->next_glue.ties + live->next_glue.count;
        if (!change->glue && sbi_live_tie_goes(change, ties + k))
            continue;
        *tie = ties[k];
        for (int side = 0; side < 2; side++)
            memcpy(tie->nodes[side], sbi_live_next_nodes(change, tie->cells[side]),
                   (size_t)live->next_glue.nodes * sizeof(int));
        live->next_glue.count++;
    }
    return SB_OK;
}

SBI_API int sbi_live_list_couplings(const sbi_glue *glue, int (*pairs)[2], int count)
{
    for (int k = 0; k < glue->count; k++)
        for (int i = 0; i < SBI_GLUE_PAIRS; i++) {
            int a = i % SBI_GLUE_FOLLOWS, b = i / SBI_GLUE_FOLLOWS;
            const sbi_glue_tie *tie = glue->ties + k;
            if (tie->nodes[0][a] == tie->nodes[1][a] || tie->nodes[0][b] == tie->nodes[1][b])
                continue;
            pairs[count][0] = tie->nodes[0][a];
            pairs[count++][1] = tie->nodes[1][b];
        }
    return count;
}

/* Leaves out couplings of nodes that go, which go with them; returns how many stay. */
static int sbi_live_drop_couplings(const sbi_mesh_change *out, int (*pairs)[2], int count)
{
    int kept = 0;
    for (int k = 0; k < count; k++) {
        int goes = 0;
        for (int i = 0; i < out->removed_node_count; i++)
            goes |= out->removed_nodes[i] == pairs[k][0] || out->removed_nodes[i] == pairs[k][1];
        if (goes)
            continue;
        pairs[kept][0] = pairs[k][0];
        pairs[kept++][1] = pairs[k][1];
    }
    return kept;
}

SBI_API void sbi_live_join_glued(sb_body *body, int *joined)
{
    const sbi_glue *glue = &body->live->glue;
    int *parts = body->element_component.items, count = 0;
    for (int c = 0; c < body->component_count; c++)
        joined[c] = c;
    for (int k = 0; k < glue->count; k++) {
        int a = joined[parts[glue->ties[k].cells[0]]], b = joined[parts[glue->ties[k].cells[1]]];
        for (int c = 0; c < body->component_count && a != b; c++)
            if (joined[c] == sbi_max_int(a, b))
                joined[c] = sbi_min_int(a, b);
    }
    for (int c = 0; c < body->component_count; c++) /* the first of each has the lowest number, which is itself */
        joined[c] = joined[c] == c ? count++ : joined[joined[c]];
    for (int e = 0; e < body->domain.cell_count; e++)
        if (parts[e] >= 0)
            parts[e] = joined[parts[e]];
    body->component_count = count;
}

/* 1 when the same nodes are tied after the change. */
static int sbi_live_glue_stays(const sbi_live *live)
{
    int stays = live->glue.count == live->next_glue.count;
    size_t size = (size_t)live->glue.nodes * sizeof(int);
    for (int k = 0; k < 2 * live->glue.count && stays; k++)
        stays = memcmp(live->glue.ties[k / 2].nodes[k % 2], live->next_glue.ties[k / 2].nodes[k % 2], size) == 0;
    return stays;
}

SBI_API sbi_matrix_couplings sbi_live_glue_couplings(sb_body *body, const sbi_mesh_change *out)
{
    sbi_live *live = body->live;
    sbi_matrix_couplings couplings;
    int all;
    memset(&couplings, 0, sizeof couplings);
    if (sbi_live_glue_stays(live))
        return couplings;
    couplings.gone_count = sbi_live_list_couplings(&live->glue, live->couplings, 0);
    couplings.gone_count = sbi_live_drop_couplings(out, live->couplings, couplings.gone_count);
    all = sbi_live_list_couplings(&live->next_glue, live->couplings, couplings.gone_count);
    couplings.made_count = all - couplings.gone_count;
    if (all) {
        couplings.gone = live->couplings[0];
        couplings.made = live->couplings[0] + 2 * couplings.gone_count;
    }
    return couplings;
}

/* Forces jump where glue comes or goes. Newmark, which damps nothing, begins anew then, with accelerations that the
 * forces give. Those of light pieces have no bound, stiffness damping makes them larger still, and with generalised
 * alpha a piece would go dt^2/6 of them astray (a stiff, damped mode at spectral radius 0): its steps go on from the
 * accelerations that were, which they forget by themselves. */
static void sbi_live_begin_anew(sb_body *body)
{
    if (body->integrator != SB_GENERALISED_ALPHA)
        body->acceleration_known = 0;
}

SBI_API void sbi_live_take_glue(sb_body *body)
{
    sbi_glue glue = body->live->glue;
    if (glue.count) /* what it held may be let go */
        sbi_live_begin_anew(body);
    body->live->glue = body->live->next_glue;
    body->live->next_glue = glue;
    body->live->next_glue.count = 0;
}

/* ---- values ---- */

/* 1 when one side of a tie stands on nodes that have no material, and are parked: a blade went exactly along the
 * boundary, or twice along one plane, and parted a film from the tissue. Nothing moves such nodes, so the tie would
 * hold the other side to the ground. Nodes that take next to no part in the jump do not count: of a film along faces
 * that lie within the tissue the one beyond has no material either. */
static int sbi_live_tie_is_idle(const sb_body *body, const sbi_glue_tie *tie)
{
    const sb_real little = (sb_real)1e-6; /* of N_a^2 */
    int nodes = body->live->glue.nodes, is_idle = 0;
    sb_real most = 0;
    for (int a = 0; a < nodes; a++)
        most = sb_max(most, tie->gram[sbi_glue_at(nodes, a, a)]);
    for (int a = 0; a < nodes; a++)
        for (int side = 0; side < 2; side++)
            is_idle |=
                body->node_component[tie->nodes[side][a]] < 0 && tie->gram[sbi_glue_at(nodes, a, a)] > little * most;
    return is_idle;
}

SBI_API void sbi_live_stiffen_glue(sb_body *body)
{
    sbi_glue *glue = &body->live->glue;
    for (int k = 0; k < glue->count; k++) {
        const sb_material *material = body->materials + body->cell_material[glue->ties[k].cells[0]];
        glue->ties[k].stiffness = sbi_live_tie_is_idle(body, glue->ties + k) ? 0 : material->lambda + 2 * material->mu;
    }
}

SBI_API void sbi_body_set_glue(sb_body *body, const sbi_glue_tie *ties, int count)
{
    sbi_glue *glue = &body->live->glue;
    for (int k = 0; k < sbi_min_int(count, glue->count); k++)
        memcpy(glue->ties[k].gram, ties[k].gram, sizeof ties[k].gram);
    sbi_live_stiffen_glue(body);
    body->force_current = 0;
    sbi_live_begin_anew(body);
    memset(&body->guard, 0, sizeof body->guard);
}

SBI_API sb_result sbi_live_check_glue(const sb_body *body, sb_error *error)
{
    const sbi_glue *glue = &body->live->glue;
    for (int k = 0; k < glue->count; k++) {
        const sbi_glue_tie *tie = glue->ties + k;
        for (int side = 0; side < 2; side++) {
            const int *nodes = sb_body_cell_nodes(body, tie->cells[side]);
            if (!nodes || memcmp(nodes, tie->nodes[side], (size_t)glue->nodes * sizeof(int)) != 0)
                return sbi_fail_element(error, SB_ERROR_STATE, tie->cells[side], "tie %d has other nodes than cell %d",
                                        k, tie->cells[side]);
        }
        for (int i = 0; i < glue->nodes * glue->nodes; i++) {
            int a = i % glue->nodes, b = i / glue->nodes;
            if (tie->nodes[0][a] != tie->nodes[1][a] && tie->nodes[0][b] != tie->nodes[1][b] &&
                sb_matrix_find(&body->matrix, tie->nodes[0][a], tie->nodes[1][b]) < 0)
                return sbi_fail_node(error, SB_ERROR_STATE, tie->nodes[0][a], "the matrix does not have tie %d", k);
        }
    }
    return SB_OK;
}
