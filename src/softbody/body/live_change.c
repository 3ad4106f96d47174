/* live_change: a change of the mesh as it is put together, checked and handed on.
 *
 * Every call is also written down as numbers (log), so that a recording can make the same calls again. Numbers of nodes
 * and cells mean what they are at that point of the change; sources and parents that the change itself made are
 * resolved to those before it when they are named. */
#include "live_change.h"

#include <string.h>

#include "live_private.h"
#include "rigid_private.h"

enum {
    SBI_CHANGE_ADD_NODE = 1,
    SBI_CHANGE_MOVE_NODE = 2,
    SBI_CHANGE_REMOVE_NODE = 3,
    SBI_CHANGE_ADD_CELL = 4,
    SBI_CHANGE_REPLACE_CELL = 5,
    SBI_CHANGE_REMOVE_CELL = 6,
    SBI_CHANGE_SLIDE_NODE = 7, /* a move with sources */
    SBI_CHANGE_ADD_PIECE = 8,  /* cells with moments */
    SBI_CHANGE_REPLACE_PIECE = 9,
    SBI_CHANGE_ADD_PART = 10, /* cells with moments and loads of faces */
    SBI_CHANGE_REPLACE_PART = 11
};
/* Moments in the log: centroid, and covariance row by row. */
enum { SBI_CHANGE_MOMENTS = 12 };

SB_API sb_change_cell sb_default_change_cell(void)
{
    sb_change_cell cell;
    memset(&cell, 0, sizeof cell);
    cell.parent = -1;
    cell.region = SB_AUTO;
    cell.share = 1;
    return cell;
}

/* ---- memory ---- */

/* Room for `more` items behind `count`; 0: no memory. */
static int sbi_change_grow(sb_body_change *change, void **array, int *capacity, int count, int more, size_t item)
{
    int64_t needed = (int64_t)count + more, roomy = needed + needed / 2 + 8;
    void *grown;
    if (needed <= *capacity)
        return 1;
    if (roomy > INT32_MAX)
        return 0;
    grown = sbi_alloc(&change->body->allocator, (size_t)roomy, item);
    if (!grown)
        return 0;
    if (count)
        memcpy(grown, *array, (size_t)count * item);
    sbi_free(&change->body->allocator, *array);
    *array = grown;
    *capacity = (int)roomy;
    return 1;
}

#define SBI_CHANGE_ROOM(change, list, more)                                                                            \
    sbi_change_grow(change, (void **)&(change)->list.items, &(change)->list.capacity, (change)->list.count, more,      \
                    sizeof *(change)->list.items)

static sb_result sbi_change_no_memory(sb_error *error)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a change of the mesh");
}

/* Room in the lists for one call: a record of each kind, `nodes` entries of nodes and weights, and the log. */
static sb_result sbi_change_reserve(sb_body_change *change, int nodes, sb_error *error)
{
    int expanded = nodes; /* sources made by this change stand for all of theirs */
    if (nodes > INT32_MAX / 64)
        return sbi_change_no_memory(error);
    if (!SBI_CHANGE_ROOM(change, made_nodes, 1) || !SBI_CHANGE_ROOM(change, removed_nodes, 1) ||
        !SBI_CHANGE_ROOM(change, moved_nodes, 1) || !SBI_CHANGE_ROOM(change, made_cells, 1) ||
        !SBI_CHANGE_ROOM(change, removed_cells, 1) || !SBI_CHANGE_ROOM(change, entries, expanded) ||
        !SBI_CHANGE_ROOM(change, corners, SB_MAX_ELEMENT_NODES) ||
        !SBI_CHANGE_ROOM(change, log_ints, nodes + 8 + SB_MAX_ELEMENT_NODES) ||
        !SBI_CHANGE_ROOM(change, log_reals, nodes + 8 + SBI_CHANGE_MOMENTS + 24))
        return sbi_change_no_memory(error);
    return SB_OK;
}

/* An index of records for so many slots; NULL: no memory. */
static int *sbi_change_make_index(sb_body_change *change, int capacity, const int *old, int old_capacity)
{
    int *index = (int *)sbi_alloc_zeroed(&change->body->allocator, (size_t)capacity, sizeof(int));
    if (index && old)
        memcpy(index, old, (size_t)old_capacity * sizeof(int));
    return index;
}

/* More slots of one kind: half as many again. */
static int sbi_change_grow_slots(sb_body_change *change, sbi_slots *slots, int **index)
{
    const sb_allocator *allocator = &change->body->allocator;
    sbi_slots grown;
    int64_t capacity = (int64_t)slots->capacity + slots->capacity / 2 + 16;
    int *more;
    if (slots->count || slots->fresh < slots->capacity)
        return 1;
    if (capacity > INT32_MAX / 8)
        return 0;
    more = sbi_change_make_index(change, (int)capacity, *index, slots->capacity);
    if (!more || !sbi_slots_copy(&grown, slots, (int)capacity, allocator)) {
        sbi_free(allocator, more);
        return 0;
    }
    sbi_free(allocator, *index);
    sbi_slots_free(slots, allocator);
    *index = more;
    *slots = grown;
    return 1;
}

static void sbi_change_log_int(sb_body_change *change, int value)
{
    change->log_ints.items[change->log_ints.count++] = value;
}

static void sbi_change_log_real(sb_body_change *change, sb_real value)
{
    change->log_reals.items[change->log_reals.count++] = value;
}

static void sbi_change_log_vector(sb_body_change *change, sb_vec3 v)
{
    sbi_change_log_real(change, v.x);
    sbi_change_log_real(change, v.y);
    sbi_change_log_real(change, v.z);
}

/* ---- begin and end ---- */

/* Slots as those of the body, and an index of as many; 0: no memory. */
static int sbi_change_copy_slots(sb_body_change *change, sbi_slots *to, const sbi_slots *from, int **index)
{
    const sb_allocator *allocator = &change->body->allocator;
    if (to->capacity == from->capacity && *index) {
        sbi_slots_assign(to, from);
        return 1;
    }
    sbi_slots_free(to, allocator);
    sbi_free(allocator, *index);
    *index = sbi_change_make_index(change, from->capacity, NULL, 0);
    return *index && sbi_slots_copy(to, from, 0, allocator);
}

/* Clears the lists; they keep their memory. */
static void sbi_change_clear(sb_body_change *change)
{
    for (int i = 0; i < change->made_nodes.count; i++)
        change->node_at[change->made_nodes.items[i].node] = 0;
    for (int i = 0; i < change->made_cells.count; i++)
        change->cell_at[change->made_cells.items[i].cell] = 0;
    change->made_nodes.count = change->removed_nodes.count = change->moved_nodes.count = 0;
    change->made_cells.count = change->removed_cells.count = 0;
    change->entries.count = change->corners.count = 0;
    change->log_ints.count = change->log_reals.count = 0;
    change->found.count = change->found_next = 0;
    change->glue = NULL;
}

/* An empty change with room in its lists for so many cells, or NULL. */
static sb_body_change *sbi_change_make(sb_body *body, int cells)
{
    sb_body_change *change = (sb_body_change *)sbi_alloc_zeroed(&body->allocator, 1, sizeof *change);
    if (!change)
        return NULL;
    change->body = body;
    if (!SBI_CHANGE_ROOM(change, made_nodes, cells) || !SBI_CHANGE_ROOM(change, removed_nodes, cells) ||
        !SBI_CHANGE_ROOM(change, moved_nodes, cells) || !SBI_CHANGE_ROOM(change, made_cells, cells) ||
        !SBI_CHANGE_ROOM(change, removed_cells, cells) || !SBI_CHANGE_ROOM(change, entries, 4 * cells) ||
        !SBI_CHANGE_ROOM(change, corners, cells * body->domain.nodes_per_cell) ||
        !SBI_CHANGE_ROOM(change, log_ints, (12 + body->domain.nodes_per_cell) * cells) ||
        !SBI_CHANGE_ROOM(change, log_reals, (12 + 24) * cells) ||
        !sbi_change_copy_slots(change, &change->nodes, &body->live->nodes, &change->node_at) ||
        !sbi_change_copy_slots(change, &change->cells, &body->live->cells, &change->cell_at)) {
        sbi_change_destroy(change);
        return NULL;
    }
    return change;
}

SBI_API sb_result sbi_change_take_spare(sb_body *body, int cells, sb_error *error)
{
    size_t bytes = 4096 + 768 * (size_t)cells;
    body->live->spare = sbi_change_make(body, cells);
    body->live->lists = sbi_alloc(&body->allocator, bytes, 1);
    body->live->list_bytes = body->live->lists ? bytes : 0;
    return body->live->spare && body->live->lists ? SB_OK : sbi_change_no_memory(error);
}

SB_API sb_result sb_body_change_begin(sb_body *body, sb_body_change **change, sb_error *error)
{
    sb_body_change *made;
    if (!body || !change)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_change_begin needs a body and a place for the change");
    if (!body->live)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the mesh of this body cannot change: def.slack was 0");
    if (body->live->open)
        return sbi_fail(error, SB_ERROR_STATE, "another change of this body is open");
    made = body->live->spare;
    if (!sbi_change_copy_slots(made, &made->nodes, &body->live->nodes, &made->node_at) ||
        !sbi_change_copy_slots(made, &made->cells, &body->live->cells, &made->cell_at))
        return sbi_change_no_memory(error);
    made->version = body->live->version;
    body->live->spare = NULL;
    body->live->open = made;
    *change = made;
    return SB_OK;
}

SB_API void sb_body_change_cancel(sb_body_change *change)
{
    if (!change)
        return;
    sbi_change_clear(change);
    change->body->live->open = NULL;
    change->body->live->erodes = 0;
    change->body->live->spare = change;
}

SBI_API void sbi_change_set_glue(sb_body_change *change, const sbi_glue_tie *ties, int count)
{
    change->glue = ties;
    change->glue_count = count;
}

SBI_API void sbi_change_erode(sb_body_change *change) { change->body->live->erodes = 1; }

SBI_API void sbi_change_destroy(sb_body_change *change)
{
    sb_allocator allocator;
    if (!change)
        return;
    allocator = change->body->allocator;
    sbi_slots_free(&change->nodes, &allocator);
    sbi_slots_free(&change->cells, &allocator);
    sbi_free(&allocator, change->node_at);
    sbi_free(&allocator, change->cell_at);
    sbi_free(&allocator, change->made_nodes.items);
    sbi_free(&allocator, change->removed_nodes.items);
    sbi_free(&allocator, change->moved_nodes.items);
    sbi_free(&allocator, change->made_cells.items);
    sbi_free(&allocator, change->removed_cells.items);
    sbi_free(&allocator, change->entries.items);
    sbi_free(&allocator, change->corners.items);
    sbi_free(&allocator, change->log_ints.items);
    sbi_free(&allocator, change->log_reals.items);
    sbi_free(&allocator, change->found.items);
    sbi_free(&allocator, change);
}

/* ---- what numbers mean at this point ---- */

/* The record of a node that this change made and did not remove again, or NULL. */
static sbi_changed_node *sbi_change_made_node(sb_body_change *change, int node)
{
    int at = node >= 0 && node < change->nodes.capacity ? change->node_at[node] : 0;
    return at && !change->made_nodes.items[at - 1].dropped ? change->made_nodes.items + at - 1 : NULL;
}

static sbi_changed_cell *sbi_change_made_cell(sb_body_change *change, int cell)
{
    int at = cell >= 0 && cell < change->cells.capacity ? change->cell_at[cell] : 0;
    return at && !change->made_cells.items[at - 1].dropped ? change->made_cells.items + at - 1 : NULL;
}

/* Finite weights >= 0 that sum to 1, and nodes known before the change or in use now. */
static sb_result sbi_change_check_list(sb_body_change *change, const int *nodes, const sb_real *weights, int count,
                                       const char *what, sb_error *error)
{
    double sum = 0;
    if (count < 0 || (count > 0 && (!nodes || !weights)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the list of %s is NULL or its count %d negative", what, count);
    for (int k = 0; k < count; k++) {
        if (!sb_is_finite(weights[k]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, nodes[k], "a weight among the %s is not finite", what);
        if (weights[k] < 0)
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, nodes[k], "a weight among the %s is negative: %g", what,
                                 (double)weights[k]);
        if (!sbi_slots_is_used(&change->nodes, nodes[k]) && !sb_body_node_in_use(change->body, nodes[k]))
            return sbi_fail_node(error, SB_ERROR_INDEX, nodes[k], "node %d among the %s is not in use", nodes[k], what);
        sum += (double)weights[k];
    }
    if (count > 0 && !(sum > 1 - 1e-4 && sum < 1 + 1e-4))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the weights of the %s sum to %g, not to 1", what, sum);
    return SB_OK;
}

/* How many sources a list has once those made by this change stand for theirs. */
static int sbi_change_expanded(sb_body_change *change, const int *nodes, int count)
{
    int64_t sum = 0;
    for (int k = 0; k < count; k++) {
        const sbi_changed_node *made = sbi_change_made_node(change, nodes[k]);
        sum += made ? made->count : 1;
    }
    return sum < INT32_MAX / 64 ? (int)sum : INT32_MAX;
}

/* Appends one source, or adds to it. */
static void sbi_change_add_entry(sb_body_change *change, int first, int node, sb_real weight)
{
    for (int k = first; k < change->entries.count; k++)
        if (change->entries.items[k].node == node) {
            change->entries.items[k].weight += weight;
            return;
        }
    change->entries.items[change->entries.count].node = node;
    change->entries.items[change->entries.count++].weight = weight;
}

/* Appends sources to the entries, in numbers before the change; there is room. */
static void sbi_change_expand(sb_body_change *change, const int *nodes, const sb_real *weights, int count)
{
    int first = change->entries.count;
    for (int k = 0; k < count; k++) {
        const sbi_changed_node *made = sbi_change_made_node(change, nodes[k]);
        for (int j = 0; made && j < made->count; j++) {
            sbi_change_entry source = change->entries.items[made->first + j];
            sbi_change_add_entry(change, first, source.node, weights[k] * source.weight);
        }
        if (!made)
            sbi_change_add_entry(change, first, nodes[k], weights[k]);
    }
}

static void sbi_change_log_list(sb_body_change *change, const int *nodes, const sb_real *weights, int count)
{
    sbi_change_log_int(change, count);
    for (int k = 0; k < count; k++) {
        sbi_change_log_int(change, nodes[k]);
        sbi_change_log_real(change, weights[k]);
    }
}

/* ---- nodes ---- */

static int sbi_change_knows_flags(int flags)
{
    int keep = SB_NODE_KEEP_X | SB_NODE_KEEP_Y | SB_NODE_KEEP_Z;
    return flags == 0 || (flags & ~keep) == SB_NODE_COPY;
}

SB_API sb_result sb_body_change_add_node(sb_body_change *change, sb_vec3 position, const int *sources,
                                         const sb_real *weights, int count, int flags, int *node, sb_error *error)
{
    sbi_changed_node *made;
    int slot, expanded;
    sb_result result;
    if (!change || !node || count < 1 || !sbi_change_knows_flags(flags))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "sb_body_change_add_node needs a change, a place for the number, at "
                        "least one source and known flags");
    if (!sb_v3_is_finite(position))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the place of the new node is not finite");
    result = sbi_change_check_list(change, sources, weights, count, "sources", error);
    if (result != SB_OK)
        return result;
    expanded = sbi_change_expanded(change, sources, count);
    result = sbi_change_reserve(change, sbi_max_int(count, expanded), error);
    if (result == SB_OK && !sbi_change_grow_slots(change, &change->nodes, &change->node_at))
        result = sbi_change_no_memory(error);
    if (result != SB_OK)
        return result;
    made = change->made_nodes.items + change->made_nodes.count;
    memset(made, 0, sizeof *made);
    made->first = change->entries.count;
    sbi_change_expand(change, sources, weights, count);
    made->count = change->entries.count - made->first;
    slot = sbi_slots_take(&change->nodes);
    made->node = slot;
    made->position = position;
    made->flags = flags;
    change->node_at[slot] = ++change->made_nodes.count;
    sbi_change_log_int(change, SBI_CHANGE_ADD_NODE);
    sbi_change_log_int(change, flags);
    sbi_change_log_list(change, sources, weights, count);
    sbi_change_log_vector(change, position);
    *node = slot;
    return SB_OK;
}

SB_API sb_result sb_body_change_move_node(sb_body_change *change, int node, sb_vec3 position, const int *sources,
                                          const sb_real *weights, int count, sb_error *error)
{
    sbi_changed_node *made, *moved = NULL;
    int first;
    sb_result result;
    if (!change)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_change_move_node needs a change");
    if (!sb_v3_is_finite(position))
        return sbi_fail_node(error, SB_ERROR_NOT_FINITE, node, "the new place of node %d is not finite", node);
    if (!sbi_slots_is_used(&change->nodes, node))
        return sbi_fail_node(error, SB_ERROR_INDEX, node, "node %d is not in use", node);
    result = sbi_change_check_list(change, sources, weights, count, "sources", error);
    if (result == SB_OK)
        result = sbi_change_reserve(change, sbi_max_int(count, sbi_change_expanded(change, sources, count)), error);
    if (result != SB_OK)
        return result;
    first = change->entries.count;
    sbi_change_expand(change, sources, weights, count);
    made = sbi_change_made_node(change, node);
    for (int i = 0; i < change->moved_nodes.count && !made; i++)
        if (change->moved_nodes.items[i].node == node)
            moved = change->moved_nodes.items + i;
    if (!made && !moved) {
        moved = change->moved_nodes.items + change->moved_nodes.count++;
        memset(moved, 0, sizeof *moved);
        moved->node = node;
    }
    moved = made ? made : moved;
    moved->position = position;
    if (count || !made) {
        moved->first = first;
        moved->count = change->entries.count - first;
    }
    sbi_change_log_int(change, count ? SBI_CHANGE_SLIDE_NODE : SBI_CHANGE_MOVE_NODE);
    sbi_change_log_int(change, node);
    if (count)
        sbi_change_log_list(change, sources, weights, count);
    sbi_change_log_vector(change, position);
    return SB_OK;
}

SB_API sb_result sb_body_change_remove_node(sb_body_change *change, int node, const int *heirs, const sb_real *weights,
                                            int count, sb_error *error)
{
    sbi_changed_node *made, *removed;
    sb_result result;
    if (!change)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_change_remove_node needs a change");
    if (!sbi_slots_is_used(&change->nodes, node))
        return sbi_fail_node(error, SB_ERROR_INDEX, node, "node %d is not in use", node);
    result = sbi_change_check_list(change, heirs, weights, count, "heirs", error);
    for (int k = 0; k < count && result == SB_OK; k++)
        if (heirs[k] == node || !sbi_slots_is_used(&change->nodes, heirs[k]))
            result =
                sbi_fail_node(error, SB_ERROR_INDEX, heirs[k], "node %d cannot be heir of node %d", heirs[k], node);
    for (int i = 0; i < change->removed_nodes.count && result == SB_OK; i++)
        for (int k = 0; k < change->removed_nodes.items[i].count && result == SB_OK; k++)
            if (change->entries.items[change->removed_nodes.items[i].first + k].node == node)
                result = sbi_fail_node(error, SB_ERROR_ARGUMENT, node,
                                       "node %d is the heir of node %d, which this "
                                       "change removes",
                                       node, change->removed_nodes.items[i].node);
    if (result == SB_OK)
        result = sbi_change_reserve(change, count, error);
    if (result != SB_OK)
        return result;
    made = sbi_change_made_node(change, node);
    if (made) {
        made->dropped = 1;
    } else {
        removed = change->removed_nodes.items + change->removed_nodes.count++;
        memset(removed, 0, sizeof *removed);
        removed->node = node;
        removed->first = change->entries.count;
        for (int k = 0; k < count; k++)
            sbi_change_add_entry(change, removed->first, heirs[k], weights[k]);
        removed->count = change->entries.count - removed->first;
        for (int i = 0; i < change->moved_nodes.count; i++)
            if (change->moved_nodes.items[i].node == node) {
                change->moved_nodes.items[i] = change->moved_nodes.items[--change->moved_nodes.count];
                break;
            }
    }
    sbi_slots_give(&change->nodes, node);
    sbi_change_log_int(change, SBI_CHANGE_REMOVE_NODE);
    sbi_change_log_int(change, node);
    sbi_change_log_list(change, heirs, weights, count);
    return SB_OK;
}

/* ---- cells ---- */

/* Index of a region, or -1. */
static int sbi_change_region(const sb_body *body, int region)
{
    for (int i = 0; i < body->material_count; i++)
        if (body->material_regions[i] == region)
            return i;
    return -1;
}

static sb_result sbi_change_check_moments(const sb_body *body, const sb_change_cell *cell, sb_error *error)
{
    const sb_cell_moments *moments = cell->moments;
    const int nodes = body->domain.nodes_per_cell, face_nodes = sbi_piece_face_nodes(nodes);
    sb_result result = sbi_live_check_pieces(body, error);
    sbi_piece piece;
    int finite = sb_v3_is_finite(moments->centroid);
    if (result != SB_OK)
        return result;
    piece = sbi_piece_make(moments->centroid, &moments->covariance, nodes, cell->face_loads);
    for (int i = 0; i < 3; i++)
        finite &= sb_v3_is_finite(sb_m3_column(moments->covariance, i));
    for (int k = 0; cell->face_loads && k < 4 * face_nodes; k++)
        finite &= sb_is_finite(cell->face_loads[k]);
    if (!finite)
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the moments of a cell are not finite");
    if (!sbi_piece_is_sound(&piece, nodes))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the moments of a cell are not those of a piece of a tet");
    return SB_OK;
}

/* Checks all of a cell but what its nodes will be; *parent is its number before the change. */
static sb_result sbi_change_check_cell(sb_body_change *change, const sb_change_cell *cell, int *parent, sb_error *error)
{
    const sb_body *body = change->body;
    const sbi_changed_cell *made = sbi_change_made_cell(change, cell->parent);
    *parent = made ? made->parent : cell->parent;
    if (!cell->nodes)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the nodes of a cell are NULL");
    if (*parent != -1 && !sb_body_cell_in_use(body, *parent))
        return sbi_fail_element(error, SB_ERROR_INDEX, *parent, "the parent %d of a cell was not in use", *parent);
    if (cell->region != SB_AUTO && sbi_change_region(body, cell->region) < 0)
        return sbi_fail(error, SB_ERROR_INDEX, "the mesh was made without a region %d", cell->region);
    if (!(cell->moments ? cell->share >= 0 : cell->share > 0) || !(cell->share <= 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the share %g of a cell is not in (0, 1]", (double)cell->share);
    if (cell->fibre && !sb_v3_is_finite(*cell->fibre))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the fibre of a cell is not finite");
    if (cell->fibre && !body->fibres)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a cell has a fibre, but the body has none: sb_body_set_fibres");
    if (cell->face_loads && !cell->moments)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "loads of faces go with the moments of a piece");
    return cell->moments ? sbi_change_check_moments(body, cell, error) : SB_OK;
}

static void sbi_change_log_cell(sb_body_change *change, const sb_change_cell *cell)
{
    sbi_change_log_int(change, cell->parent);
    sbi_change_log_int(change, cell->region);
    sbi_change_log_int(change, cell->fibre != NULL);
    for (int a = 0; a < change->body->domain.nodes_per_cell; a++)
        sbi_change_log_int(change, cell->nodes[a]);
    sbi_change_log_real(change, cell->share);
    sbi_change_log_vector(change, cell->fibre ? *cell->fibre : sb_v3(0, 0, 0));
    if (cell->moments) {
        sbi_change_log_vector(change, cell->moments->centroid);
        for (int i = 0; i < 9; i++)
            sbi_change_log_real(change, cell->moments->covariance.m[i / 3][i % 3]);
    }
    for (int k = 0; cell->face_loads && k < 4 * sbi_piece_face_nodes(change->body->domain.nodes_per_cell); k++)
        sbi_change_log_real(change, cell->face_loads[k]);
}

/* Puts a checked cell into a slot that was taken for it; there is room. */
static void sbi_change_put_cell(sb_body_change *change, int slot, const sb_change_cell *cell, int parent)
{
    const sb_body *body = change->body;
    sbi_changed_cell *made = change->made_cells.items + change->made_cells.count++;
    memset(made, 0, sizeof *made);
    made->cell = slot;
    change->cell_at[slot] = change->made_cells.count;
    made->parent = parent;
    made->share = cell->share;
    if (cell->moments)
        made->piece = sbi_piece_make(cell->moments->centroid, &cell->moments->covariance, body->domain.nodes_per_cell,
                                     cell->face_loads);
    made->material = cell->region != SB_AUTO ? sbi_change_region(body, cell->region)
                     : parent >= 0           ? body->cell_material[parent]
                                             : 0;
    made->has_fibre = cell->fibre != NULL;
    if (cell->fibre)
        sbi_body_copy_fibres(&made->fibre, cell->fibre, 1);
    else if (parent >= 0 && body->fibres)
        made->fibre = body->fibres[parent];
    made->first = change->corners.count;
    for (int a = 0; a < body->domain.nodes_per_cell; a++)
        change->corners.items[change->corners.count++] = cell->nodes[a];
}

/* Notes that a cell in use goes; its slot stays taken. */
static void sbi_change_drop_cell(sb_body_change *change, int number)
{
    sbi_changed_cell *made = sbi_change_made_cell(change, number);
    if (made)
        made->dropped = 1;
    else
        change->removed_cells.items[change->removed_cells.count++] = number;
}

SB_API sb_result sb_body_change_add_cell(sb_body_change *change, const sb_change_cell *cell, int *number,
                                         sb_error *error)
{
    int parent, slot;
    sb_result result;
    if (!change || !cell)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_change_add_cell needs a change and a cell");
    result = sbi_change_check_cell(change, cell, &parent, error);
    if (result == SB_OK)
        result = sbi_change_reserve(change, 0, error);
    if (result == SB_OK && !sbi_change_grow_slots(change, &change->cells, &change->cell_at))
        result = sbi_change_no_memory(error);
    if (result != SB_OK)
        return result;
    slot = sbi_slots_take(&change->cells);
    sbi_change_log_int(change, cell->face_loads ? SBI_CHANGE_ADD_PART
                               : cell->moments  ? SBI_CHANGE_ADD_PIECE
                                                : SBI_CHANGE_ADD_CELL);
    sbi_change_log_cell(change, cell);
    sbi_change_put_cell(change, slot, cell, parent);
    if (number)
        *number = slot;
    return SB_OK;
}

SB_API sb_result sb_body_change_replace_cell(sb_body_change *change, int number, const sb_change_cell *cell,
                                             sb_error *error)
{
    int parent;
    sb_result result;
    if (!change || !cell)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_change_replace_cell needs a change and a cell");
    if (!sbi_slots_is_used(&change->cells, number))
        return sbi_fail_element(error, SB_ERROR_INDEX, number, "cell %d is not in use", number);
    result = sbi_change_check_cell(change, cell, &parent, error);
    if (result == SB_OK)
        result = sbi_change_reserve(change, 0, error);
    if (result != SB_OK)
        return result;
    sbi_change_log_int(change, cell->face_loads ? SBI_CHANGE_REPLACE_PART
                               : cell->moments  ? SBI_CHANGE_REPLACE_PIECE
                                                : SBI_CHANGE_REPLACE_CELL);
    sbi_change_log_int(change, number);
    sbi_change_log_cell(change, cell);
    sbi_change_drop_cell(change, number);
    sbi_change_put_cell(change, number, cell, parent);
    return SB_OK;
}

SB_API sb_result sb_body_change_remove_cell(sb_body_change *change, int number, sb_error *error)
{
    sb_result result;
    if (!change)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_change_remove_cell needs a change");
    if (!sbi_slots_is_used(&change->cells, number))
        return sbi_fail_element(error, SB_ERROR_INDEX, number, "cell %d is not in use", number);
    result = sbi_change_reserve(change, 0, error);
    if (result != SB_OK)
        return result;
    sbi_change_log_int(change, SBI_CHANGE_REMOVE_CELL);
    sbi_change_log_int(change, number);
    sbi_change_drop_cell(change, number);
    sbi_slots_give(&change->cells, number);
    return SB_OK;
}

/* ---- a recorded change ---- */

typedef struct sbi_change_reader {
    const sbi_command *command;
    size_t ints, reals;
    int bad;
} sbi_change_reader;

static int sbi_change_next_int(sbi_change_reader *reader)
{
    reader->bad |= reader->ints >= reader->command->int_count;
    return reader->bad ? 0 : reader->command->ints[reader->ints++];
}

static sb_real sbi_change_next_real(sbi_change_reader *reader)
{
    reader->bad |= reader->reals >= reader->command->real_count;
    return reader->bad ? 0 : reader->command->reals[reader->reals++];
}

static sb_vec3 sbi_change_next_vector(sbi_change_reader *reader)
{
    sb_vec3 v;
    v.x = sbi_change_next_real(reader);
    v.y = sbi_change_next_real(reader);
    v.z = sbi_change_next_real(reader);
    return v;
}

/* Nodes and weights that follow; borrowed from the command. */
static int sbi_change_next_list(sbi_change_reader *reader, const int **nodes, const sb_real **weights)
{
    int count = sbi_change_next_int(reader);
    if (reader->bad || count < 0 || (size_t)count > reader->command->int_count - reader->ints ||
        (size_t)count > reader->command->real_count - reader->reals) {
        reader->bad = 1;
        return 0;
    }
    *nodes = reader->command->ints + reader->ints;
    *weights = reader->command->reals + reader->reals;
    reader->ints += (size_t)count;
    reader->reals += (size_t)count;
    return count;
}

/* Makes a cell again. */
static sb_result sbi_change_replay_cell(sb_body_change *change, sbi_change_reader *reader, int call, sb_error *error)
{
    int replaces =
        call == SBI_CHANGE_REPLACE_CELL || call == SBI_CHANGE_REPLACE_PIECE || call == SBI_CHANGE_REPLACE_PART;
    int is_part = call == SBI_CHANGE_ADD_PART || call == SBI_CHANGE_REPLACE_PART;
    int nodes[SB_MAX_ELEMENT_NODES], has_fibre, number = replaces ? sbi_change_next_int(reader) : -1;
    sb_change_cell cell = sb_default_change_cell();
    sb_cell_moments moments;
    sb_real face_loads[24];
    sb_vec3 fibre;
    cell.parent = sbi_change_next_int(reader);
    cell.region = sbi_change_next_int(reader);
    has_fibre = sbi_change_next_int(reader);
    for (int a = 0; a < change->body->domain.nodes_per_cell; a++)
        nodes[a] = sbi_change_next_int(reader);
    cell.nodes = nodes;
    cell.share = sbi_change_next_real(reader);
    fibre = sbi_change_next_vector(reader);
    cell.fibre = has_fibre ? &fibre : NULL;
    if (is_part || call == SBI_CHANGE_ADD_PIECE || call == SBI_CHANGE_REPLACE_PIECE) {
        moments.centroid = sbi_change_next_vector(reader);
        for (int i = 0; i < 9; i++)
            moments.covariance.m[i / 3][i % 3] = sbi_change_next_real(reader);
        cell.moments = &moments;
    }
    for (int k = 0; is_part && k < 4 * sbi_piece_face_nodes(change->body->domain.nodes_per_cell); k++)
        face_loads[k] = sbi_change_next_real(reader);
    cell.face_loads = is_part ? face_loads : NULL;
    if (reader->bad)
        return SB_OK;
    return replaces ? sb_body_change_replace_cell(change, number, &cell, error)
                    : sb_body_change_add_cell(change, &cell, NULL, error);
}

/* Makes one call again. */
static sb_result sbi_change_replay_call(sb_body_change *change, sbi_change_reader *reader, sb_error *error)
{
    int call = sbi_change_next_int(reader), count = 0, number, flag;
    const int *list = NULL;
    const sb_real *weights = NULL;
    sb_vec3 v;
    if (call == SBI_CHANGE_ADD_NODE || call == SBI_CHANGE_REMOVE_NODE) {
        flag = sbi_change_next_int(reader);
        count = sbi_change_next_list(reader, &list, &weights);
        v = call == SBI_CHANGE_ADD_NODE ? sbi_change_next_vector(reader) : sb_v3(0, 0, 0);
        if (reader->bad)
            return SB_OK;
        return call == SBI_CHANGE_ADD_NODE
                   ? sb_body_change_add_node(change, v, list, weights, count, flag, &number, error)
                   : sb_body_change_remove_node(change, flag, list, weights, count, error);
    }
    if (call == SBI_CHANGE_ADD_CELL || call == SBI_CHANGE_REPLACE_CELL ||
        (call >= SBI_CHANGE_ADD_PIECE && call <= SBI_CHANGE_REPLACE_PART))
        return sbi_change_replay_cell(change, reader, call, error);
    number = sbi_change_next_int(reader);
    if (call == SBI_CHANGE_FOUND) {
        if (!SBI_CHANGE_ROOM(change, found, 1))
            return sbi_change_no_memory(error);
        change->found.items[change->found.count++] = number;
        return SB_OK;
    }
    if (call == SBI_CHANGE_MOVE_NODE || call == SBI_CHANGE_SLIDE_NODE) {
        count = call == SBI_CHANGE_SLIDE_NODE ? sbi_change_next_list(reader, &list, &weights) : 0;
        v = sbi_change_next_vector(reader);
        return reader->bad ? SB_OK : sb_body_change_move_node(change, number, v, list, weights, count, error);
    }
    reader->bad |= call != SBI_CHANGE_REMOVE_CELL;
    return reader->bad ? SB_OK : sb_body_change_remove_cell(change, number, error);
}

SBI_API sb_result sbi_change_replay(sb_body *body, const sbi_command *command, sb_error *error)
{
    sbi_change_reader reader;
    sb_body_change *change;
    sb_result result = sb_body_change_begin(body, &change, error);
    memset(&reader, 0, sizeof reader);
    reader.command = command;
    if (result != SB_OK)
        return result;
    while (result == SB_OK && !reader.bad && reader.ints < command->int_count)
        result = sbi_change_replay_call(change, &reader, error);
    if (result == SB_OK && (reader.bad || reader.reals != command->real_count))
        result = sbi_fail(error, SB_ERROR_FORMAT, "a recorded change of the mesh is damaged");
    if (result == SB_OK)
        result = sb_body_change_commit(change, error);
    if (result != SB_OK)
        sb_body_change_cancel(change);
    return result;
}

/* ---- commit ---- */

/* Lays out the arrays of the change as others learn of it. */
static void sbi_change_layout(const sb_body_change *change, sbi_change_lists *lists, sbi_arena *arena)
{
    size_t n = (size_t)change->body->domain.nodes_per_cell, entries = (size_t)change->entries.count;
    size_t made = (size_t)change->made_nodes.count, removed = (size_t)change->removed_nodes.count;
    size_t moved = (size_t)change->moved_nodes.count, gone = (size_t)change->removed_cells.count;
    size_t come = (size_t)change->made_cells.count;
    lists->made_nodes = (int *)sbi_arena_take(arena, made, sizeof(int));
    lists->made_copies = (unsigned char *)sbi_arena_take(arena, made, 1);
    lists->source_start = (int *)sbi_arena_take(arena, made + 1, sizeof(int));
    lists->sources = (int *)sbi_arena_take(arena, entries, sizeof(int));
    lists->source_weights = (sb_real *)sbi_arena_take(arena, entries, sizeof(sb_real));
    lists->removed_nodes = (int *)sbi_arena_take(arena, removed, sizeof(int));
    lists->heir_start = (int *)sbi_arena_take(arena, removed + 1, sizeof(int));
    lists->heirs = (int *)sbi_arena_take(arena, entries, sizeof(int));
    lists->heir_weights = (sb_real *)sbi_arena_take(arena, entries, sizeof(sb_real));
    lists->moved_nodes = (int *)sbi_arena_take(arena, moved, sizeof(int));
    lists->made_positions = (sb_vec3 *)sbi_arena_take(arena, made, sizeof(sb_vec3));
    lists->moved_from = (sb_vec3 *)sbi_arena_take(arena, moved, sizeof(sb_vec3));
    lists->moved_to = (sb_vec3 *)sbi_arena_take(arena, moved, sizeof(sb_vec3));
    lists->moved_start = (int *)sbi_arena_take(arena, moved + 1, sizeof(int));
    lists->moved_sources = (int *)sbi_arena_take(arena, entries, sizeof(int));
    lists->moved_weights = (sb_real *)sbi_arena_take(arena, entries, sizeof(sb_real));
    lists->removed_cells = (int *)sbi_arena_take(arena, gone, sizeof(int));
    lists->removed_cell_nodes = (int *)sbi_arena_take(arena, gone, n * sizeof(int));
    lists->made_cells = (int *)sbi_arena_take(arena, come, sizeof(int));
    lists->made_cell_nodes = (int *)sbi_arena_take(arena, come, n * sizeof(int));
    lists->made_parents = (int *)sbi_arena_take(arena, come, sizeof(int));
    lists->made_shares = (sb_real *)sbi_arena_take(arena, come, sizeof(sb_real));
    lists->reshaped_cells = (int *)sbi_arena_take(arena, (size_t)change->reshaped_most, sizeof(int));
    lists->reshaped_shares = (sb_real *)sbi_arena_take(arena, (size_t)change->reshaped_most, sizeof(sb_real));
    lists->motions = (sbi_live_motion *)sbi_arena_take(arena, made + moved, sizeof(sbi_live_motion));
    lists->forces = (sb_vec3 *)sbi_arena_take(arena, removed, sizeof(sb_vec3));
    lists->node_room = n * (gone + come + (size_t)change->reshaped_most) + made + removed + moved +
                       2 * n * (size_t)(change->body->live->glue.count + change->body->live->next_glue.count);
    lists->nodes = (int *)sbi_arena_take(arena, lists->node_room, sizeof(int));
    lists->gone = (int *)sbi_arena_take(arena, lists->node_room, sizeof(int));
    lists->come = (int *)sbi_arena_take(arena, lists->node_room, sizeof(int));
}

/* Upper bound of the cells that a moved node reshapes. */
static int sbi_change_count_reshaped(const sb_body_change *change)
{
    const sb_body *body = change->body;
    int64_t count = 0;
    for (int i = 0; i < change->moved_nodes.count; i++) {
        int node = change->moved_nodes.items[i].node;
        for (int at = sbi_live_first_cell(body, node); at >= 0; at = sbi_live_next_cell(body, node, at))
            count++;
    }
    return count < INT32_MAX ? (int)count : INT32_MAX;
}

/* Lists a record's sources or heirs; returns the end of the list. */
static int sbi_change_list_entries(const sb_body_change *change, const sbi_changed_node *node, int end, int *nodes,
                                   sb_real *weights)
{
    for (int k = 0; k < node->count; k++, end++) {
        nodes[end] = change->entries.items[node->first + k].node;
        weights[end] = change->entries.items[node->first + k].weight;
    }
    return end;
}

static void sbi_change_list_nodes(const sb_body_change *change, sbi_change_lists *lists, sb_mesh_change *out)
{
    int entries = 0;
    for (int i = 0; i < change->made_nodes.count; i++) {
        const sbi_changed_node *node = change->made_nodes.items + i;
        if (node->dropped)
            continue;
        lists->made_nodes[out->made_node_count] = node->node;
        lists->made_positions[out->made_node_count] = node->position;
        lists->made_copies[out->made_node_count] = (unsigned char)node->flags;
        lists->source_start[out->made_node_count++] = entries;
        entries = sbi_change_list_entries(change, node, entries, lists->sources, lists->source_weights);
    }
    lists->source_start[out->made_node_count] = entries;
    entries = 0;
    for (int i = 0; i < change->removed_nodes.count; i++) {
        const sbi_changed_node *node = change->removed_nodes.items + i;
        lists->removed_nodes[i] = node->node;
        lists->heir_start[i] = entries;
        entries = sbi_change_list_entries(change, node, entries, lists->heirs, lists->heir_weights);
    }
    out->removed_node_count = change->removed_nodes.count;
    lists->heir_start[out->removed_node_count] = entries;
    out->moved_node_count = change->moved_nodes.count;
    entries = 0;
    for (int i = 0; i < change->moved_nodes.count; i++) {
        const sbi_changed_node *node = change->moved_nodes.items + i;
        lists->moved_nodes[i] = node->node;
        lists->moved_from[i] = change->body->reference[node->node];
        lists->moved_to[i] = node->position;
        lists->moved_start[i] = entries;
        entries = sbi_change_list_entries(change, node, entries, lists->moved_sources, lists->moved_weights);
    }
    lists->moved_start[out->moved_node_count] = entries;
}

static void sbi_change_list_cells(const sb_body_change *change, sbi_change_lists *lists, sb_mesh_change *out)
{
    const sb_body *body = change->body;
    size_t n = (size_t)body->domain.nodes_per_cell;
    out->removed_cell_count = change->removed_cells.count;
    for (int i = 0; i < change->removed_cells.count; i++) {
        lists->removed_cells[i] = change->removed_cells.items[i];
        memcpy(lists->removed_cell_nodes + (size_t)i * n, body->domain.cells + (size_t)lists->removed_cells[i] * n,
               n * sizeof(int));
    }
    for (int i = 0; i < change->made_cells.count; i++) {
        const sbi_changed_cell *cell = change->made_cells.items + i;
        if (cell->dropped)
            continue;
        lists->made_cells[out->made_cell_count] = cell->cell;
        lists->made_parents[out->made_cell_count] = cell->parent;
        lists->made_shares[out->made_cell_count] = cell->share;
        memcpy(lists->made_cell_nodes + (size_t)out->made_cell_count * n, change->corners.items + cell->first,
               n * sizeof(int));
        out->made_cell_count++;
    }
}

/* Cells that stay while a node of theirs moves, each once, by the order of the nodes. */
static void sbi_change_list_reshaped(const sb_body_change *change, sbi_change_lists *lists, sb_mesh_change *out)
{
    const sb_body *body = change->body;
    unsigned char *marks = body->live->cell_marks;
    for (int i = 0; i < change->removed_cells.count; i++)
        marks[change->removed_cells.items[i]] = 1;
    for (int i = 0; i < change->moved_nodes.count; i++) {
        int node = change->moved_nodes.items[i].node;
        for (int at = sbi_live_first_cell(body, node); at >= 0; at = sbi_live_next_cell(body, node, at)) {
            int e = sbi_live_cell_of(body, at);
            if (marks[e])
                continue;
            marks[e] = 1;
            lists->reshaped_shares[out->reshaped_cell_count] = body->live->shares[e];
            lists->reshaped_cells[out->reshaped_cell_count++] = e;
        }
    }
    for (int i = 0; i < change->removed_cells.count; i++)
        marks[change->removed_cells.items[i]] = 0;
    for (int i = 0; i < out->reshaped_cell_count; i++)
        marks[lists->reshaped_cells[i]] = 0;
}

/* The mesh that the change leads to. */
static void sbi_change_apply(const sb_body_change *change, sbi_live_mesh *mesh)
{
    const sb_body *body = change->body;
    int n = body->domain.nodes_per_cell;
    for (int i = 0; i < change->removed_cells.count; i++) {
        int e = change->removed_cells.items[i];
        if (e >= mesh->cells.end)
            continue;
        memset(mesh->corners + (size_t)e * (size_t)n, 0, (size_t)n * sizeof(int));
        mesh->shares[e] = 0;
        if (mesh->pieces)
            memset(mesh->pieces + e, 0, sizeof *mesh->pieces);
        mesh->inherit[e] = -1;
        mesh->kept[e] = 0;
        if (mesh->patches)
            mesh->patches[e] = -1;
    }
    for (int i = 0; i < change->made_nodes.count; i++)
        if (!change->made_nodes.items[i].dropped)
            mesh->positions[change->made_nodes.items[i].node] = change->made_nodes.items[i].position;
    for (int i = 0; i < change->moved_nodes.count; i++)
        mesh->positions[change->moved_nodes.items[i].node] = change->moved_nodes.items[i].position;
    for (int i = 0; i < change->made_cells.count; i++) {
        const sbi_changed_cell *cell = change->made_cells.items + i;
        if (cell->dropped)
            continue;
        memcpy(mesh->corners + (size_t)cell->cell * (size_t)n, change->corners.items + cell->first,
               (size_t)n * sizeof(int));
        mesh->material[cell->cell] = cell->material;
        mesh->shares[cell->cell] = cell->share;
        if (mesh->pieces)
            mesh->pieces[cell->cell] = cell->piece;
        mesh->inherit[cell->cell] = cell->parent;
        mesh->kept[cell->cell] = 0;
        if (mesh->patches)
            mesh->patches[cell->cell] = cell->parent >= 0 ? body->domain.cell_patch[cell->parent] : -1;
        if (mesh->fibres)
            mesh->fibres[cell->cell] = cell->fibre;
    }
}

/* Whether every cell has nodes that are in use, each once. */
static sb_result sbi_change_check_corners(const sb_body *body, const sbi_live_mesh *mesh, sb_error *error)
{
    int n = body->domain.nodes_per_cell, cells = 0;
    for (int e = 0; e < mesh->cells.end; e++) {
        const int *cell = mesh->corners + (size_t)e * (size_t)n;
        int used = mesh->cells.used[e];
        cells += used && mesh->shares[e] > 0;
        for (int a = 0; a < n && used; a++) {
            if (!sbi_slots_is_used(&mesh->nodes, cell[a])) {
                sbi_fail_element(error, SB_ERROR_INDEX, e, "cell %d has node %d, which is not in use after the change",
                                 e, cell[a]);
                if (error)
                    error->node = cell[a];
                return SB_ERROR_INDEX;
            }
            for (int b = 0; b < a; b++)
                if (cell[b] == cell[a])
                    return sbi_fail_element(error, SB_ERROR_INDEX, e, "cell %d has node %d twice", e, cell[a]);
        }
    }
    return cells || body->live->erodes ? SB_OK : sbi_fail(error, SB_ERROR_MESH, "the change would leave no cell");
}

/* The change as others learn of it, in memory that the body keeps for the next one. */
static sb_result sbi_change_list(sb_body_change *change, sbi_change_lists *lists, sb_mesh_change *out, sb_error *error)
{
    sb_body *body = change->body;
    sbi_live *live = body->live;
    sbi_arena arena = {NULL, 0, 0};
    memset(out, 0, sizeof *out);
    memset(lists, 0, sizeof *lists);
    change->reshaped_most = sbi_change_count_reshaped(change);
    sbi_change_layout(change, lists, &arena);
    if (arena.overflow || arena.used > (size_t)-1 / 2)
        return sbi_change_no_memory(error);
    if (arena.used > live->list_bytes) {
        void *memory = sbi_alloc(&body->allocator, arena.used + arena.used / 2, 1);
        if (!memory)
            return sbi_change_no_memory(error);
        sbi_free(&body->allocator, live->lists);
        live->lists = memory;
        live->list_bytes = arena.used + arena.used / 2;
    }
    arena.base = (unsigned char *)live->lists;
    arena.used = 0;
    sbi_change_layout(change, lists, &arena);
    out->node_end = change->nodes.end;
    out->cell_end = change->cells.end;
    out->nodes_per_cell = body->domain.nodes_per_cell;
    sbi_change_list_nodes(change, lists, out);
    sbi_change_list_cells(change, lists, out);
    sbi_change_list_reshaped(change, lists, out);
    out->made_nodes = lists->made_nodes;
    out->made_positions = lists->made_positions;
    out->made_copies = lists->made_copies;
    out->source_start = lists->source_start;
    out->sources = lists->sources;
    out->source_weights = lists->source_weights;
    out->removed_nodes = lists->removed_nodes;
    out->heir_start = lists->heir_start;
    out->heirs = lists->heirs;
    out->heir_weights = lists->heir_weights;
    out->moved_nodes = lists->moved_nodes;
    out->moved_from = lists->moved_from;
    out->moved_to = lists->moved_to;
    out->moved_start = lists->moved_start;
    out->moved_sources = lists->moved_sources;
    out->moved_weights = lists->moved_weights;
    out->removed_cells = lists->removed_cells;
    out->removed_cell_nodes = lists->removed_cell_nodes;
    out->made_cells = lists->made_cells;
    out->made_cell_nodes = lists->made_cell_nodes;
    out->made_parents = lists->made_parents;
    out->made_shares = lists->made_shares;
    out->find_cell = change->body->live->find_knows ? change->body->live->find : NULL;
    out->find_user = change->body->live->find_user;
    out->reshaped_cells = lists->reshaped_cells;
    out->reshaped_shares = lists->reshaped_shares;
    return SB_OK;
}

/* The mesh that it leads to, and the checks that need no neighbours. */
static sb_result sbi_change_make_mesh(const sb_body_change *change, const sb_mesh_change *out, sbi_live_mesh *mesh,
                                      sb_error *error)
{
    const sb_body *body = change->body;
    sb_result result = sbi_live_mesh_allocate(body, &change->nodes, &change->cells,
                                              body->live->piece_count || sbi_change_makes_pieces(change), mesh, error);
    if (result != SB_OK)
        return result;
    sbi_live_mesh_fill(body, mesh);
    sbi_change_apply(change, mesh);
    mesh->glue = body->live->next_glue.ties;
    mesh->glue_count = body->live->next_glue.count;
    result = sbi_change_check_corners(body, mesh, error);
    if (result == SB_OK)
        result = sbi_live_check_removed(body, &mesh->nodes, out, error);
    if (result == SB_OK)
        result = sbi_live_settle_patches(body, mesh, error);
    return result;
}

/* Whether all nodes that a change should leave in cells are; node_marks are 0 before and after. */
static sb_result sbi_change_check_lonely(const sb_body *body, const sb_mesh_change *out, const sbi_live_mesh *mesh,
                                         sb_error *error)
{
    int *marks = body->live->node_marks;
    sb_result result = SB_OK;
    for (int e = 0; e < mesh->cells.end; e++)
        for (int a = 0; a < 4 && mesh->cells.used[e]; a++)
            marks[mesh->corners[4 * (size_t)e + (size_t)a]] = 1;
    for (int i = 0; i < out->made_node_count && result == SB_OK; i++)
        if (!marks[out->made_nodes[i]])
            result = sbi_live_refuse_lonely(out->made_nodes[i], 1, error);
    for (int i = 0; i < sbi_min_int(body->domain.node_count, mesh->nodes.end) && result == SB_OK; i++)
        if (mesh->nodes.used[i] && sbi_live_first_cell(body, i) >= 0 && !marks[i])
            result = sbi_live_refuse_lonely(i, 0, error);
    memset(marks, 0, (size_t)mesh->nodes.end * sizeof *marks);
    return result;
}

/* What else can be seen to be wrong with a mesh of tet4 before a body is made of it. */
static sb_result sbi_change_check_mesh(const sb_body *body, const sb_mesh_change *out, const sbi_live_mesh *mesh,
                                       sb_error *error)
{
    sb_result result = SB_OK;
    sbi_tet_rule rule;
    if (!sbi_live_follows(body) || mesh->nodes.end > body->live->nodes.capacity)
        return SB_OK;
    sbi_domain_make_tet_rule(&body->domain, &rule);
    for (int e = 0; e < mesh->cells.end && result == SB_OK; e++) {
        sb_vec3 x[4];
        for (int a = 0; a < 4; a++)
            x[a] = mesh->positions[mesh->corners[4 * (size_t)e + (size_t)a]];
        if (mesh->cells.used[e])
            result = sbi_domain_check_tet(&rule, e, x, mesh->shares[e], mesh->pieces && mesh->pieces[e].is != 0, error);
    }
    return result == SB_OK && !body->live->erodes ? sbi_change_check_lonely(body, out, mesh, error) : result;
}

/* Makes the change on a body of its own, beside the present one, which takes its place. */
static sb_result sbi_change_rebuild(sb_body_change *change, const sb_mesh_change *out, sb_error *error)
{
    sb_body *body = change->body, *next = NULL;
    sbi_live_mesh mesh;
    sb_result result;
    memset(&mesh, 0, sizeof mesh);
    result = sbi_change_make_mesh(change, out, &mesh, error);
    if (result == SB_OK)
        result = sbi_change_check_mesh(body, out, &mesh, error);
    if (result == SB_OK) {
        body->live->rebuilds++;
        result = sbi_live_build(body, &mesh, &next, error);
    }
    if (result == SB_OK)
        result = sbi_live_carry(body, out, &mesh, next, error);
    if (result == SB_OK)
        result = sbi_live_ask_listeners(body, out, error);
    if (result == SB_OK) {
        sbi_live_replace(body, next);
        next = NULL;
    }
    sbi_body_release(next);
    sbi_live_mesh_free(body, &mesh);
    return result;
}

/* Room to write down where rows of mappings and points of cables go; 0: no memory. */
static int sbi_change_reserve_found(sb_body_change *change)
{
    const sb_body *body = change->body;
    int64_t rows = 0;
    for (int i = 0; i < body->load_count; i++)
        rows += body->loads[i].kind == SBI_LOAD_MAPPING || body->loads[i].kind == SBI_LOAD_CABLE
                    ? body->loads[i].row_count
                    : 0;
    return rows < INT32_MAX / 4 && SBI_CHANGE_ROOM(change, log_ints, 2 * (int)rows);
}

SB_API sb_result sb_body_change_commit(sb_body_change *change, sb_error *error)
{
    sbi_change_lists lists;
    sb_mesh_change out;
    sb_body *body;
    sb_result result;
    int calls;
    if (!change)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_change_commit needs a change");
    body = change->body;
    calls = change->log_ints.count;
    if (change->version != body->live->version)
        return sbi_fail(error, SB_ERROR_STATE, "the body got another mesh after the change had begun");
    result = sbi_live_make_next_glue(change, error);
    if (result == SB_OK)
        result = sbi_change_list(change, &lists, &out, error);
    if (result == SB_OK && !sbi_change_reserve_found(change))
        result = sbi_change_no_memory(error);
    if (result == SB_OK && !sbi_live_follow(change, &lists, &out, &result, error))
        result = sbi_change_rebuild(change, &out, error);
    if (result != SB_OK) {
        change->log_ints.count = calls; /* without what it found */
        change->found_next = 0;
        return result;
    }
    sbi_rigids_follow(body, &out);
    sbi_body_tell(body, SBI_COMMAND_CHANGE, 0, 0, change->log_ints.items, (size_t)change->log_ints.count,
                  change->log_reals.items, (size_t)change->log_reals.count);
    for (int i = 0; i < body->live->listener_count; i++)
        body->live->listeners[i].calls.follow(body->live->listeners[i].calls.user, body, &out);
    sb_body_change_cancel(change);
    return SB_OK;
}
