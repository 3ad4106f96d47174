/* live_mesh: readings and listeners of a mesh that may change. */
#include "live_mesh.h"
#include "live_private.h"

#include <string.h>

/* ---- what a body has of it ---- */

enum { SBI_LIVE_LISTED = 1024 }; /* cells that the lists of a change have room for from the beginning, or the slack */

SBI_API sb_result sbi_live_prepare(sb_body *body, sb_error *error)
{
    int more = body->live ? body->live->cells.capacity - body->domain.cell_count : 0;
    int cells = sbi_max_int(16, sbi_min_int(more, SBI_LIVE_LISTED));
    sb_result result = body->live ? sbi_change_take_spare(body, cells, error) : SB_OK;
    if (result == SB_OK && sbi_live_follows(body))
        result = sbi_matrix_reserve_plan(&body->matrix, 12 * cells, error);
    if (result == SB_OK && sbi_live_follows(body))
        result = sbi_assembly_reserve_parents(&body->assembly, cells, error);
    return result;
}

SBI_API void sbi_live_end(sb_body *body)
{
    sbi_live *live = body->live;
    if (!live)
        return;
    while (live->listener_count > 0) {
        const sb_body_listener *calls = &live->listeners[--live->listener_count].calls;
        if (calls->end)
            calls->end(calls->user);
    }
    sb_body_change_cancel(live->open);
    sbi_change_destroy(live->spare);
    live->spare = NULL;
}

/* ---- readings ---- */

SB_API sb_result sb_body_get_mesh(const sb_body *body, const sb_allocator *allocator, sb_mesh *mesh, int *nodes,
                                  int *cells, sb_error *error)
{
    sb_mesh made;
    int *number, count = 0, n;
    if (!body || !mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_get_mesh needs a body and a mesh");
    memset(&made, 0, sizeof made);
    if (allocator)
        made.allocator = *allocator;
    n = body->domain.nodes_per_cell;
    made.element_type = body->domain.element_type;
    made.table = body->domain.table;
    number = (int *)sbi_alloc(allocator, (size_t)body->domain.node_count, sizeof(int));
    made.nodes = (sb_vec3 *)sbi_alloc(allocator, (size_t)body->domain.node_count, sizeof(sb_vec3));
    made.elements = (int *)sbi_alloc(allocator, (size_t)body->domain.cell_count, (size_t)n * sizeof(int));
    made.regions = (int *)sbi_alloc(allocator, (size_t)body->domain.cell_count, sizeof(int));
    if (!number || !made.nodes || !made.elements || !made.regions) {
        sbi_free(allocator, number);
        sb_mesh_free(&made);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a mesh of %d nodes", body->domain.node_count);
    }
    for (int i = 0; i < body->domain.node_count; i++) {
        number[i] = sb_body_node_in_use(body, i) ? count++ : -1;
        if (number[i] >= 0)
            made.nodes[number[i]] = body->reference[i];
    }
    made.node_count = count;
    for (int e = 0; e < body->domain.cell_count; e++) {
        int used = sb_body_cell_in_use(body, e);
        if (cells)
            cells[e] = used ? made.element_count : -1;
        for (int a = 0; a < n && used; a++)
            made.elements[made.element_count * n + a] = number[body->domain.cells[e * n + a]];
        if (used)
            made.regions[made.element_count++] = body->material_regions[body->cell_material[e]];
    }
    if (nodes)
        memcpy(nodes, number, (size_t)body->domain.node_count * sizeof(int));
    sbi_free(allocator, number);
    *mesh = made;
    return SB_OK;
}

/* ---- listeners ---- */

/* Puts a listener behind all others, or behind those that lead; there is room. */
static void sbi_live_insert_listener(sbi_live *live, const sb_body_listener *listener, int leads)
{
    int at = live->listener_count++;
    for (; leads && at > 0 && !live->listeners[at - 1].leads; at--)
        live->listeners[at] = live->listeners[at - 1];
    live->listeners[at].id = ++live->last_listener;
    live->listeners[at].leads = leads;
    live->listeners[at].calls = *listener;
}

SBI_API sb_result sbi_live_listen(sb_body *body, const sb_body_listener *listener, int leads, int *id, sb_error *error)
{
    sbi_live *live;
    if (!body || !listener || !listener->follow)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_listen needs a body and a listener that follows");
    live = body->live;
    if (!live)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the mesh of this body does not change: def.slack was 0");
    if (live->listener_count == live->listener_capacity) {
        int capacity = live->listener_capacity + live->listener_capacity / 2 + 4;
        sbi_listener *grown = (sbi_listener *)sbi_alloc(&body->allocator, (size_t)capacity, sizeof *grown);
        if (!grown)
            return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d listeners", capacity);
        if (live->listener_count)
            memcpy(grown, live->listeners, (size_t)live->listener_count * sizeof *grown);
        sbi_free(&body->allocator, live->listeners);
        live->listeners = grown;
        live->listener_capacity = capacity;
    }
    sbi_live_insert_listener(live, listener, leads);
    if (id)
        *id = live->last_listener;
    return SB_OK;
}

SB_API sb_result sb_body_listen(sb_body *body, const sb_body_listener *listener, int *id, sb_error *error)
{
    return sbi_live_listen(body, listener, 0, id, error);
}

SB_API sb_result sb_body_unlisten(sb_body *body, int id)
{
    sbi_live *live = body ? body->live : NULL;
    if (!body)
        return SB_ERROR_ARGUMENT;
    for (int i = 0; live && i < live->listener_count; i++)
        if (live->listeners[i].id == id) {
            live->listener_count--;
            memmove(live->listeners + i, live->listeners + i + 1,
                    (size_t)(live->listener_count - i) * sizeof *live->listeners);
            return SB_OK;
        }
    return SB_ERROR_INDEX;
}

/* ---- check ---- */

static sb_result sbi_live_check_slots(const sbi_slots *slots, int end, const char *what, sb_error *error)
{
    int stacked = 0;
    if (slots->end != end || slots->fresh > slots->capacity || slots->end > slots->fresh)
        return sbi_fail(error, SB_ERROR_STATE, "slots of %s end at %d, not at %d", what, slots->end, end);
    if (end > 0 && !slots->used[end - 1])
        return sbi_fail(error, SB_ERROR_STATE, "the last slot of %s is free", what);
    for (int i = 0; i < slots->fresh; i++)
        stacked += !slots->used[i];
    if (stacked != slots->count)
        return sbi_fail(error, SB_ERROR_STATE, "%d slots of %s are free, %d wait to be used", stacked, what,
                        slots->count);
    for (int k = 0; k < slots->count; k++)
        if (slots->stack[k] < 0 || slots->stack[k] >= slots->fresh || slots->used[slots->stack[k]])
            return sbi_fail(error, SB_ERROR_STATE, "slot %d of %s waits though it is in use", slots->stack[k], what);
    return SB_OK;
}

/* Corners, share and volume of one cell. */
static sb_result sbi_live_check_cell(const sb_body *body, int e, sb_error *error)
{
    const sb_domain *domain = &body->domain;
    int n = domain->nodes_per_cell, q = domain->points_per_cell, used = body->live->cells.used[e] != 0;
    const int *cell = domain->cells + (size_t)e * (size_t)n;
    int is_piece = sbi_live_is_piece(body, e);
    if (is_piece ? !used || body->live->shares[e] < 0 : used != (body->live->shares[e] > 0))
        return sbi_fail_element(error, SB_ERROR_STATE, e, "cell %d has the share %g", e, (double)body->live->shares[e]);
    for (int p = 0; p < q && !is_piece; p++)
        if ((domain->weights[(size_t)e * (size_t)q + (size_t)p] > 0) != used)
            return sbi_fail_element(error, SB_ERROR_STATE, e, "cell %d has the weight %g at point %d", e,
                                    (double)domain->weights[(size_t)e * (size_t)q + (size_t)p], p);
    for (int a = 0; a < n; a++) {
        if (used ? !sb_body_node_in_use(body, cell[a]) : cell[a] != 0)
            return sbi_fail_element(error, SB_ERROR_STATE, e, "cell %d has node %d, which is not in use", e, cell[a]);
        for (int b = 0; b < n && used; b++)
            if (sb_matrix_find(&body->matrix, cell[a], cell[b]) < 0)
                return sbi_fail_element(error, SB_ERROR_STATE, e, "the matrix does not couple nodes %d and %d", cell[a],
                                        cell[b]);
    }
    return SB_OK;
}

/* Motion of free nodes, and mass and elements of all; mass: summed anew; *listed: counts the elements. */
static sb_result sbi_live_check_node(const sb_body *body, int i, sb_real mass, size_t *listed, sb_error *error)
{
    int n = body->domain.nodes_per_cell;
    sb_vec3 u = body->displacement[i], v = body->velocity[i];
    if (!sb_body_node_in_use(body, i) && (u.x != 0 || u.y != 0 || u.z != 0 || v.x != 0 || v.y != 0 || v.z != 0 ||
                                          body->fixed[i] != SB_XYZ || body->node_component[i] >= 0))
        return sbi_fail_node(error, SB_ERROR_STATE, i, "free node %d moves or is not held", i);
    if (sb_abs(body->lumped_mass[i] - mass) > 1000 * SB_EPSILON * mass)
        return sbi_fail_node(error, SB_ERROR_STATE, i, "node %d has the mass %g, its cells give it %g", i,
                             (double)body->lumped_mass[i], (double)mass);
    for (int at = sbi_live_first_cell(body, i); at >= 0; at = sbi_live_next_cell(body, i, at)) {
        int e = sbi_live_cell_of(body, at), found = 0;
        const int *cell = body->domain.cells + (size_t)e * (size_t)n;
        ++*listed;
        for (int a = 0; a < n; a++)
            found |= cell[a] == i;
        if (!found || !sb_body_cell_in_use(body, e))
            return sbi_fail_node(error, SB_ERROR_STATE, i, "node %d is said to be in cell %d", i, e);
    }
    return SB_OK;
}

/* Whether each box holds the nodes of its part, and has the nodes in its sides that it counts; sides: [parts][6]
 * zeros. */
static sb_result sbi_live_check_boxes(const sb_body *body, int (*sides)[6], sb_error *error)
{
    const int nothing[6] = {0, 0, 0, 0, 0, 0}; /* of a part of empty pieces */
    for (int i = 0; i < body->domain.node_count; i++) {
        int c = body->node_component[i];
        sb_vec3 x = body->reference[i], low, high;
        if (c >= body->component_count)
            return sbi_fail_node(error, SB_ERROR_STATE, i, "node %d is in part %d of %d", i, c, body->component_count);
        if (c < 0)
            continue;
        low = body->component_low[c], high = body->component_high[c];
        if (x.x < low.x || x.y < low.y || x.z < low.z || x.x > high.x || x.y > high.y || x.z > high.z)
            return sbi_fail_node(error, SB_ERROR_STATE, i, "node %d is outside the box of part %d", i, c);
        sides[c][0] += x.x == low.x, sides[c][1] += x.y == low.y, sides[c][2] += x.z == low.z;
        sides[c][3] += x.x == high.x, sides[c][4] += x.y == high.y, sides[c][5] += x.z == high.z;
    }
    for (int c = 0; c < body->component_count; c++)
        if ((!sbi_body_box_is_right(body, c) && memcmp(sides[c], nothing, sizeof nothing) != 0) ||
            memcmp(sides[c], body->component_faces[c], sizeof sides[c]) != 0)
            return sbi_fail(error, SB_ERROR_STATE, "the box of part %d has not the nodes in its sides that it counts",
                            c);
    return SB_OK;
}

/* Parts, their boxes, and the count of the supports' blocks. */
static sb_result sbi_live_check_parts(const sb_body *body, sb_error *error)
{
    int(*sides)[6] = (int(*)[6])sbi_alloc_zeroed(&body->allocator, (size_t)body->component_count + 1, sizeof *sides);
    int blocks = 0;
    sb_result result = sides ? sbi_live_check_boxes(body, sides, error)
                             : sbi_fail(error, SB_ERROR_MEMORY, "no memory to check %d parts", body->component_count);
    sbi_free(&body->allocator, sides);
    for (int i = 0; i < body->domain.node_count; i++)
        if (body->fixed[i] && body->node_component[i] >= 0)
            blocks += body->matrix.row_end[i] - body->matrix.row_start[i];
    if (result == SB_OK && blocks != body->support_used)
        result =
            sbi_fail(error, SB_ERROR_STATE, "the rows of supports have %d blocks, not %d", blocks, body->support_used);
    return result;
}

SB_API sb_result sb_body_live_check(const sb_body *body, sb_error *error)
{
    sb_result result = SB_OK;
    sb_real *mass;
    size_t used = 0, listed = 0;
    int pieces = 0;
    if (!body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_live_check needs a body");
    if (!body->live)
        return SB_OK;
    result = sbi_live_check_slots(&body->live->nodes, body->domain.node_count, "nodes", error);
    if (result == SB_OK)
        result = sbi_live_check_slots(&body->live->cells, body->domain.cell_count, "cells", error);
    if (result != SB_OK)
        return result;
    mass = (sb_real *)sbi_alloc_zeroed(&body->allocator, (size_t)body->domain.node_count, sizeof *mass);
    if (!mass)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory to check %d nodes", body->domain.node_count);
    for (int e = 0; e < body->domain.cell_count && result == SB_OK; e++) {
        sb_real lumped[SB_MAX_ELEMENT_NODES * SB_MAX_ELEMENT_NODES], load[SB_MAX_ELEMENT_NODES];
        sb_vec3 x[SB_MAX_ELEMENT_NODES];
        int n = body->domain.nodes_per_cell;
        const int *cell = body->domain.cells + (size_t)e * (size_t)n;
        result = sbi_live_check_cell(body, e, error);
        if (result != SB_OK || !sb_body_cell_in_use(body, e))
            continue;
        used += (size_t)n;
        for (int a = 0; a < n; a++)
            x[a] = body->reference[cell[a]];
        sbi_body_cell_mass(body, e, SB_MASS_LUMPED, x, lumped, load);
        pieces += sbi_live_is_piece(body, e);
        for (int a = 0; a < n; a++)
            mass[cell[a]] += sbi_live_density(body, e) * lumped[a * n + a];
    }
    for (int i = 0; i < body->domain.node_count && result == SB_OK; i++)
        result = sbi_live_check_node(body, i, mass[i], &listed, error);
    if (result == SB_OK && pieces != body->live->piece_count)
        result = sbi_fail(error, SB_ERROR_STATE, "%d cells are pieces, not %d", pieces, body->live->piece_count);
    if (result == SB_OK && used != listed)
        result = sbi_fail(error, SB_ERROR_STATE, "the lists of cells by node hold %lu corners of %lu",
                          (unsigned long)listed, (unsigned long)used);
    if (result == SB_OK)
        result = sbi_live_check_glue(body, error);
    if (result == SB_OK)
        result = sbi_live_check_parts(body, error);
    if (result == SB_OK)
        result = sbi_matrix_check_live(&body->matrix, error);
    sbi_free(&body->allocator, mass);
    return result;
}
