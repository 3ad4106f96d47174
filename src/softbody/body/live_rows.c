/* live_rows: loads and constraints follow a change of the mesh: their next form is made on the body that comes. */
#include "live_change.h"

#include <string.h>

#include "cable_law.h"
#include "cavity_law.h"
#include "constraint.h"
#include "load.h"

/* Scratch of one change. */
typedef struct sbi_live_rows {
    const sb_body *body;
    const sbi_mesh_change *change;
    sb_body *next;
    int *removed_of;      /* [old nodes] index among the removed nodes, or -1 */
    int *made_of;         /* [new nodes] index among the made nodes, or -1 */
    int *place;           /* [new nodes] where the row at work has the node, or -1 */
    unsigned char *marks; /* [new nodes] marks of the face at work */
    /* the rows being made */
    int *start, *nodes;
    sb_element_type *types;
    sb_real *weights;
    int row_capacity, entry_capacity, rows, entries;
    void *memory;
} sbi_live_rows;

static sb_result sbi_live_rows_no_memory(sb_error *error)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for loads and constraints to follow a change of the mesh");
}

static void sbi_live_rows_layout(sbi_live_rows *rows, sbi_arena *arena)
{
    size_t old = (size_t)rows->body->domain.node_count, now = (size_t)rows->next->domain.node_count;
    rows->removed_of = (int *)sbi_arena_take(arena, old, sizeof(int));
    rows->made_of = (int *)sbi_arena_take(arena, now, sizeof(int));
    rows->place = (int *)sbi_arena_take(arena, now, sizeof(int));
    rows->marks = (unsigned char *)sbi_arena_take(arena, now, 1);
}

static int sbi_live_rows_begin(sbi_live_rows *rows)
{
    sbi_arena arena = {NULL, 0, 0};
    sbi_live_rows_layout(rows, &arena);
    rows->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&rows->body->allocator, arena.used + 1, 1);
    if (!rows->memory)
        return 0;
    arena.base = (unsigned char *)rows->memory;
    arena.used = 0;
    sbi_live_rows_layout(rows, &arena);
    for (int i = 0; i < rows->body->domain.node_count; i++)
        rows->removed_of[i] = -1;
    for (int i = 0; i < rows->next->domain.node_count; i++)
        rows->made_of[i] = rows->place[i] = -1;
    for (int i = 0; i < rows->change->removed_node_count; i++)
        rows->removed_of[rows->change->removed_nodes[i]] = i;
    for (int i = 0; i < rows->change->made_node_count; i++)
        rows->made_of[rows->change->made_nodes[i]] = i;
    return 1;
}

static void sbi_live_rows_end(sbi_live_rows *rows)
{
    const sb_allocator *allocator = &rows->body->allocator;
    sbi_free(allocator, rows->memory);
    sbi_free(allocator, rows->start);
    sbi_free(allocator, rows->nodes);
    sbi_free(allocator, rows->types);
    sbi_free(allocator, rows->weights);
}

/* A larger copy of an array, or NULL. */
static void *sbi_live_rows_grow(const sbi_live_rows *rows, const void *array, size_t used, size_t capacity, size_t item)
{
    void *grown = sbi_alloc(&rows->body->allocator, capacity, item);
    if (grown && used)
        memcpy(grown, array, used * item);
    return grown;
}

/* Room for one row more of so many entries. */
static int sbi_live_rows_room(sbi_live_rows *rows, int entries)
{
    if (rows->rows + 2 > rows->row_capacity) {
        int capacity = rows->row_capacity + rows->row_capacity / 2 + 16;
        int *start = (int *)sbi_live_rows_grow(rows, rows->start, rows->start ? (size_t)rows->rows + 1 : 0,
                                               (size_t)capacity, sizeof(int));
        sb_element_type *types = (sb_element_type *)sbi_live_rows_grow(rows, rows->types, (size_t)rows->rows,
                                                                       (size_t)capacity, sizeof(sb_element_type));
        sbi_free(&rows->body->allocator, start ? rows->start : NULL);
        rows->start = start ? start : rows->start;
        sbi_free(&rows->body->allocator, types ? rows->types : NULL);
        rows->types = types ? types : rows->types;
        if (!start || !types)
            return 0;
        rows->row_capacity = capacity;
    }
    if (entries > rows->entry_capacity - rows->entries) {
        int64_t capacity = (int64_t)rows->entries + entries + rows->entry_capacity / 2 + 64;
        int *nodes;
        sb_real *weights;
        if (capacity > INT32_MAX)
            return 0;
        nodes = (int *)sbi_live_rows_grow(rows, rows->nodes, (size_t)rows->entries, (size_t)capacity, sizeof(int));
        weights = (sb_real *)sbi_live_rows_grow(rows, rows->weights, (size_t)rows->entries, (size_t)capacity,
                                                sizeof(sb_real));
        sbi_free(&rows->body->allocator, nodes ? rows->nodes : NULL);
        rows->nodes = nodes ? nodes : rows->nodes;
        sbi_free(&rows->body->allocator, weights ? rows->weights : NULL);
        rows->weights = weights ? weights : rows->weights;
        if (!nodes || !weights)
            return 0;
        rows->entry_capacity = (int)capacity;
    }
    return 1;
}

static void sbi_live_rows_clear(sbi_live_rows *rows)
{
    rows->rows = rows->entries = 0;
    rows->start[0] = 0;
}

/* Adds to the row at work, which began at start[rows]; there is room. */
static void sbi_live_rows_add(sbi_live_rows *rows, int node, sb_real weight)
{
    if (rows->place[node] < 0) {
        rows->place[node] = rows->entries;
        rows->nodes[rows->entries] = node;
        rows->weights[rows->entries++] = weight;
    } else {
        rows->weights[rows->place[node]] += weight;
    }
}

static void sbi_live_rows_close(sbi_live_rows *rows)
{
    for (int k = rows->start[rows->rows]; k < rows->entries; k++)
        rows->place[rows->nodes[k]] = -1;
    rows->start[++rows->rows] = rows->entries;
}

/* ---- springs and mappings ---- */

/* 1 when a cell of the next mesh has all nodes of the list. */
static int sbi_live_share_cell(const sb_body *body, const int *nodes, int count)
{
    int n = body->domain.nodes_per_cell;
    for (int at = sbi_live_first_cell(body, nodes[0]); at >= 0; at = sbi_live_next_cell(body, nodes[0], at)) {
        const int *cell = body->domain.cells + (size_t)sbi_live_cell_of(body, at) * (size_t)n;
        int found = 0;
        for (int i = 0; i < count; i++)
            for (int a = 0; a < n; a++)
                found += cell[a] == nodes[i];
        if (found == count)
            return 1;
    }
    return 0;
}

/* Index of a removed cell that had all these nodes, or -1. */
static int sbi_live_removed_cell(const sbi_mesh_change *change, const int *nodes, int count)
{
    int n = change->nodes_per_cell;
    for (int c = 0; c < change->removed_cell_count; c++) {
        int found = 0;
        for (int i = 0; i < count; i++)
            for (int a = 0; a < n; a++)
                found += change->removed_cell_nodes[c * n + a] == nodes[i];
        if (found == count)
            return c;
    }
    return -1;
}

/* Shape functions of a tet4 at a point (m); returns the least. */
static double sbi_live_tet_weights(const sb_body *body, const int *cell, const double point[3], double weight[4])
{
    double edge[3][3], rest[3], det, least;
    sb_vec3 origin = body->reference[cell[0]];
    for (int a = 0; a < 3; a++) {
        sb_vec3 x = body->reference[cell[a + 1]];
        edge[a][0] = (double)x.x - (double)origin.x;
        edge[a][1] = (double)x.y - (double)origin.y;
        edge[a][2] = (double)x.z - (double)origin.z;
    }
    rest[0] = point[0] - (double)origin.x;
    rest[1] = point[1] - (double)origin.y;
    rest[2] = point[2] - (double)origin.z;
    weight[0] = 1;
    for (int a = 0; a < 3; a++) { /* triple products with the two other edges */
        const double *b = edge[(a + 1) % 3], *c = edge[(a + 2) % 3];
        const double cross[3] = {b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]};
        det = edge[a][0] * cross[0] + edge[a][1] * cross[1] + edge[a][2] * cross[2];
        weight[a + 1] = (rest[0] * cross[0] + rest[1] * cross[1] + rest[2] * cross[2]) / det;
        weight[0] -= weight[a + 1];
    }
    least = weight[0];
    for (int a = 1; a < 4; a++)
        least = weight[a] < least ? weight[a] : least;
    return least;
}

/* H^T X of a row in a body, in double. */
static void sbi_live_rest_point(const sb_body *body, const int *nodes, const sb_real *weights, int count, double x[3])
{
    x[0] = x[1] = x[2] = 0;
    for (int k = 0; k < count; k++) {
        x[0] += (double)weights[k] * (double)body->reference[nodes[k]].x;
        x[1] += (double)weights[k] * (double)body->reference[nodes[k]].y;
        x[2] += (double)weights[k] * (double)body->reference[nodes[k]].z;
    }
}

/* A row that is a point in a removed tet4 becomes that point of the made cell that has it; 0: it is none, or none
 * has. */
static int sbi_live_relocate(sbi_live_rows *rows, const int *nodes, const sb_real *weights, int count)
{
    const sbi_mesh_change *change = rows->change;
    double point[3], weight[4], best = -1e-6, sum = 0;
    int found = -1, removed;
    if (rows->body->domain.element_type != SB_TET4 || count > 4)
        return 0;
    for (int k = 0; k < count; k++)
        sum += (double)weights[k];
    removed = sbi_live_removed_cell(change, nodes, count);
    if (removed < 0 || !(fabs(sum - 1) < 1e-5))
        return 0;
    sbi_live_rest_point(rows->body, nodes, weights, count, point);
    for (int i = 0; i < change->made_cell_count; i++) {
        double least = sbi_live_tet_weights(rows->next, change->made_cell_nodes + 4 * i, point, weight);
        if (change->made_parents[i] == change->removed_cells[removed] && least > best) {
            best = least;
            found = i;
        }
    }
    if (found < 0)
        return 0;
    sbi_live_tet_weights(rows->next, change->made_cell_nodes + 4 * found, point, weight);
    for (int a = 0; a < 4; a++)
        if (fabs(weight[a]) > 64 * (double)SB_EPSILON)
            sbi_live_rows_add(rows, change->made_cell_nodes[4 * found + a], (sb_real)weight[a]);
    return 1;
}

/* sb_body_find_cell in the mesh to come; it is written down, and in a replay as it was written. */
static int sbi_live_find(sb_body_change *change, int cell, const sb_real xi[3])
{
    const sbi_live *live = change->body->live;
    int found = cell;
    if (change->found_next < change->found.count)
        found = change->found.items[change->found_next++];
    else if (live->find && live->find_knows)
        found = live->find(live->find_user, cell, xi);
    if (!sbi_slots_is_used(&change->cells, found))
        return cell;
    change->log_ints.items[change->log_ints.count++] = SBI_CHANGE_FOUND;
    change->log_ints.items[change->log_ints.count++] = found;
    return found;
}

/* Barycentrics of the point whose shape functions these are in a tet10; 0: it has none. */
static int sbi_live_find_barycentrics(const sb_real weights[10], sb_real at[4])
{
    sb_real shape[10];
    int fits = 1;
    for (int a = 0; a < 4; a++)
        at[a] = weights[a];
    for (int e = 0; e < 6; e++) {
        int edge[3];
        sb_element_edge(SB_TET10, e, edge);
        at[edge[0]] += weights[edge[2]] / 2;
        at[edge[1]] += weights[edge[2]] / 2;
    }
    sb_element_shape(SB_TET10, at + 1, shape, NULL);
    for (int a = 0; a < 10; a++)
        fits &= sb_abs(shape[a] - weights[a]) < (sb_real)1e-5;
    return fits;
}

/* A row that is a point in an element that was cut goes over to the piece that has it. 1: done; 0: it is none, or its
 * cell is no piece. */
static int sbi_live_repoint(sbi_live_rows *rows, const int *nodes, const sb_real *weights, int count)
{
    const sbi_mesh_change *change = rows->change;
    int n = change->nodes_per_cell, local[SB_MAX_ELEMENT_NODES], removed = -1, cell = -1, found;
    sb_real shares[SB_MAX_ELEMENT_NODES], at[4], sum = 0;
    if (!rows->next->live->piece_count || count > n)
        return 0;
    memset(shares, 0, sizeof shares);
    removed = sbi_live_removed_cell(change, nodes, count);
    for (int k = 0; k < count && removed >= 0; k++) {
        local[k] = 0;
        while (change->removed_cell_nodes[n * removed + local[k]] != nodes[k])
            local[k]++;
        shares[local[k]] = weights[k];
        sum += weights[k];
    }
    for (int i = 0; i < change->made_cell_count && removed >= 0 && cell < 0; i++)
        if (change->made_parents[i] == change->removed_cells[removed])
            cell = change->made_cells[i];
    if (cell < 0 || !(sb_abs(sum - 1) < (sb_real)1e-5) || !sbi_live_is_piece(rows->next, cell) ||
        (n > 4 && !sbi_live_find_barycentrics(shares, at)))
        return 0;
    found = sbi_live_find(rows->body->live->open, cell, n > 4 ? at + 1 : shares + 1);
    for (int k = 0; k < count; k++)
        sbi_live_rows_add(rows, rows->next->domain.cells[(size_t)n * (size_t)found + (size_t)local[k]], weights[k]);
    return 1;
}

/* 1 when the row has a node that goes. */
static int sbi_live_loses_node(const sbi_live_rows *rows, const int *nodes, int count)
{
    for (int k = 0; k < count; k++)
        if (rows->removed_of[nodes[k]] >= 0)
            return 1;
    return 0;
}

/* The next form of one row of springs or a mapping, or of a point of a cable. */
static sb_result sbi_live_carry_row(sbi_live_rows *rows, const sbi_load *load, int j, sb_error *error)
{
    const sbi_mesh_change *change = rows->change;
    const int *nodes = load->nodes + load->row_start[j];
    const sb_real *weights = load->weights + load->row_start[j];
    int count = load->row_start[j + 1] - load->row_start[j], lost = sbi_live_loses_node(rows, nodes, count);
    int most = 4, is_point = load->kind == SBI_LOAD_MAPPING ||
                             (load->kind == SBI_LOAD_CABLE && !sbi_cable_point_is_in_space(load, j));
    for (int k = 0; k < count; k++) {
        int r = rows->removed_of[nodes[k]], heirs = r < 0 ? 1 : change->heir_start[r + 1] - change->heir_start[r];
        if (heirs == 0 || (heirs > 1 && load->kind == SBI_LOAD_SPRINGS))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, nodes[k],
                                 load->kind == SBI_LOAD_SPRINGS
                                     ? "spring %d of load %d is at node %d, which goes and has not one heir"
                                     : "row %d of load %d has node %d, which goes and has no heir",
                                 j, load->id, nodes[k]);
        most += heirs;
    }
    if (!sbi_live_rows_room(rows, most))
        return sbi_live_rows_no_memory(error);
    if (is_point && !lost && sbi_live_repoint(rows, nodes, weights, count)) {
        sbi_live_rows_close(rows);
        return SB_OK;
    }
    if (is_point && (lost || (count <= 4 && !sbi_live_share_cell(rows->next, nodes, count))) &&
        sbi_live_relocate(rows, nodes, weights, count)) {
        sbi_live_rows_close(rows);
        return SB_OK;
    }
    for (int k = 0; k < count; k++) {
        int r = rows->removed_of[nodes[k]];
        if (r < 0)
            sbi_live_rows_add(rows, nodes[k], weights[k]);
        for (int h = r < 0 ? 0 : change->heir_start[r]; r >= 0 && h < change->heir_start[r + 1]; h++)
            sbi_live_rows_add(rows, change->heirs[h],
                              load->kind == SBI_LOAD_SPRINGS ? weights[k] : weights[k] * change->heir_weights[h]);
    }
    sbi_live_rows_close(rows);
    return SB_OK;
}

/* What stays of a row where its nodes are others: stiffness, and where in space it is drawn to. */
static void sbi_live_carry_values(const sbi_live_rows *rows, const sbi_load *load, sbi_load *made)
{
    size_t count = (size_t)load->row_count;
    memcpy(made->stiffness, load->stiffness, count * sizeof(sb_real));
    memcpy(made->balanced_stiffness, load->balanced_stiffness, count * sizeof(sb_real));
    memcpy(made->target, load->target, count * sizeof(sb_vec3));
    memcpy(made->balanced_target, load->balanced_target, count * sizeof(sb_vec3));
    memcpy(made->force, load->force, count * sizeof(sb_vec3));
    for (int j = 0; j < load->row_count && load->kind != SBI_LOAD_CABLE; j++) {
        double old[3], now[3];
        sb_vec3 moved;
        sbi_live_rest_point(rows->body, load->nodes + load->row_start[j], load->weights + load->row_start[j],
                            load->row_start[j + 1] - load->row_start[j], old);
        sbi_live_rest_point(rows->next, made->nodes + made->row_start[j], made->weights + made->row_start[j],
                            made->row_start[j + 1] - made->row_start[j], now);
        moved = sb_v3((sb_real)(old[0] - now[0]), (sb_real)(old[1] - now[1]), (sb_real)(old[2] - now[2]));
        if (moved.x == 0 && moved.y == 0 && moved.z == 0)
            continue;
        made->target[j] = sb_v3_add(made->target[j], moved);
        made->balanced_target[j] = sb_v3_add(made->balanced_target[j], moved);
    }
}

/* ---- pressures ---- */

/* Marks the nodes that a face may consist of now: its own, the heirs of those that went, and made ones all of whose
 * sources are among its own. value 0 takes the marks away. */
static void sbi_live_mark_face(sbi_live_rows *rows, const int *nodes, int count, unsigned char value)
{
    const sbi_mesh_change *change = rows->change;
    for (int k = 0; k < count; k++) {
        int r = rows->removed_of[nodes[k]];
        if (r < 0)
            rows->marks[nodes[k]] = value;
        for (int h = r < 0 ? 0 : change->heir_start[r]; r >= 0 && h < change->heir_start[r + 1]; h++)
            rows->marks[change->heirs[h]] = value;
    }
    for (int i = 0; i < change->made_node_count; i++) {
        int inside = 1;
        for (int s = change->source_start[i]; s < change->source_start[i + 1] && inside; s++) {
            int own = 0;
            for (int k = 0; k < count; k++)
                own |= nodes[k] == change->sources[s];
            inside = own;
        }
        if (inside)
            rows->marks[change->made_nodes[i]] = value;
    }
}

/* 1 when the rows made so far, from `first` on, have this face (in any order of its nodes). */
static int sbi_live_has_face(const sbi_live_rows *rows, int first, const sbi_body_face *face)
{
    for (int j = first; j < rows->rows; j++) {
        int found = 0, size = rows->start[j + 1] - rows->start[j];
        for (int k = rows->start[j]; k < rows->start[j + 1]; k++)
            for (int i = 0; i < face->count; i++)
                found += face->nodes[i] == rows->nodes[k];
        if (size == face->count && found == size)
            return 1;
    }
    return 0;
}

static int sbi_live_add_face(sbi_live_rows *rows, const sbi_body_face *face)
{
    if (!sbi_live_rows_room(rows, face->count))
        return 0;
    for (int k = 0; k < face->count; k++) {
        rows->nodes[rows->entries] = face->nodes[k];
        rows->weights[rows->entries++] = 0;
    }
    rows->types[rows->rows] = face->type;
    rows->start[++rows->rows] = rows->entries;
    return 1;
}

/* Share of a face that is material on these nodes. */
static sb_real sbi_live_face_share(const sb_body *body, const int *nodes, int count)
{
    sb_real loads[SB_MAX_FACE_NODES];
    sbi_body_face_loads(body, nodes, count, loads);
    return sbi_piece_face_share(loads, count);
}

/* 1 when none of a face is, as pieces of its tet have all of it on other nodes. */
static int sbi_live_face_is_empty(const sbi_live_rows *rows, const int *nodes, int count)
{
    return !(sbi_live_face_share(rows->next, nodes, count) > 0);
}

/* Adds the outer faces of a made cell whose nodes are all marked; 0: no memory. */
static int sbi_live_add_parts(sbi_live_rows *rows, int made)
{
    sbi_element element = sbi_domain_element(&rows->next->domain);
    int n = rows->change->nodes_per_cell;
    int pieces = rows->next->live->piece_count > 0;
    const int *cell = rows->change->made_cell_nodes + (size_t)made * (size_t)n;
    for (int f = 0; f < sbi_element_face_count(element); f++) {
        int local[SB_MAX_FACE_NODES], nodes[SB_MAX_FACE_NODES], inside = 1;
        sb_element_type type = SB_NO_ELEMENT;
        int count = sbi_element_face(element, f, local, &type);
        sbi_body_face face;
        for (int k = 0; k < count; k++) {
            nodes[k] = cell[local[k]];
            inside &= rows->marks[nodes[k]];
        }
        if (!inside || sbi_body_get_face(rows->next, nodes, 0, count, &face, NULL) != SB_OK || face.inner ||
            sbi_live_has_face(rows, 0, &face) || (pieces && sbi_live_face_is_empty(rows, face.nodes, face.count)))
            continue;
        if (!sbi_live_add_face(rows, &face))
            return 0;
    }
    return 1;
}

/* 1 when cells behind a face that stays are other pieces now: others of them may have parts of it. */
static int sbi_live_face_is_cut(const sbi_live_rows *rows, const int *nodes, int count)
{
    return rows->next->live->piece_count > 0 && sbi_live_removed_cell(rows->change, nodes, count) >= 0;
}

/* The parts of one face, or the face as it is. */
static sb_result sbi_live_carry_face(sbi_live_rows *rows, const int *nodes, int count, sb_error *error)
{
    int lost = sbi_live_loses_node(rows, nodes, count), done = 1;
    sbi_body_face face;
    if (!lost && sbi_body_get_face(rows->next, nodes, 0, count, &face, NULL) == SB_OK && !face.inner) {
        int is_cut = sbi_live_face_is_cut(rows, nodes, count);
        if (face.count == count) /* in the order that the load has, whichever cell it is of now */
            memcpy(face.nodes, nodes, (size_t)count * sizeof *nodes);
        if (!is_cut || !(sbi_live_face_is_empty(rows, nodes, count) || sbi_live_has_face(rows, 0, &face)))
            done = sbi_live_add_face(rows, &face);
        if (!done)
            return sbi_live_rows_no_memory(error);
        if (!is_cut)
            return SB_OK;
    }
    sbi_live_mark_face(rows, nodes, count, 1);
    for (int i = 0; i < rows->change->made_cell_count && done; i++)
        done = sbi_live_add_parts(rows, i);
    sbi_live_mark_face(rows, nodes, count, 0);
    return done ? SB_OK : sbi_live_rows_no_memory(error);
}

/* ---- loads ---- */

/* What a cavity has beside its faces. */
static sb_result sbi_live_close_cavity(const sb_body *next, const sbi_load *load, sbi_load *made, sb_error *error)
{
    sb_vec3 *share = made->cavity.share;
    sb_result result = SB_OK;
    made->cavity = load->cavity;
    made->cavity.share = share;
    made->cavity.rim = NULL;
    made->cavity.rim_count = 0;
    if (made->has_parts)
        result = sbi_fail_node(error, SB_ERROR_UNSUPPORTED, made->nodes[0],
                               "a face of cavity %d would be cut through: remove the cavity first", load->id);
    if (result == SB_OK)
        result = sbi_cavity_find_rims(next, made, error);
    if (result != SB_OK)
        sbi_load_release(&next->allocator, made);
    return result;
}

/* Makes the next form of a load from the rows that were gathered. */
static sb_result sbi_live_make_load(sbi_live_rows *rows, const sbi_load *load, sbi_load *made, sb_error *error)
{
    size_t pairs = 0;
    sb_result result;
    for (int j = 0; j < rows->rows; j++) {
        size_t size = (size_t)(rows->start[j + 1] - rows->start[j]);
        if (!sbi_size_add(&pairs, size, size))
            return sbi_live_rows_no_memory(error);
    }
    result = sbi_load_make(&rows->next->allocator, load->kind, rows->rows, rows->entries, pairs, made, error);
    if (result != SB_OK)
        return result;
    memcpy(made->row_start, rows->start, ((size_t)rows->rows + 1) * sizeof(int));
    if (rows->entries > 0) /* a load that has lost all of its faces has none */
        memcpy(made->nodes, rows->nodes, (size_t)rows->entries * sizeof(int));
    made->id = load->id;
    made->balanced = load->balanced;
    made->pressure = load->pressure;
    made->balanced_pressure = load->balanced_pressure;
    memcpy(made->net, load->net, sizeof made->net);
    made->cable = load->cable;
    made->balanced_cable = load->balanced_cable;
    made->membrane = load->membrane;
    made->balanced_membrane = load->balanced_membrane;
    made->tension = load->tension;
    made->curved_energy = load->curved_energy;
    if (sbi_load_has_faces(load)) {
        memcpy(made->face_types, rows->types, (size_t)rows->rows * sizeof(sb_element_type));
        sbi_load_weigh_faces(rows->next, made);
        return load->kind == SBI_LOAD_CAVITY ? sbi_live_close_cavity(rows->next, load, made, error) : SB_OK;
    }
    memcpy(made->weights, rows->weights, (size_t)rows->entries * sizeof(sb_real));
    sbi_live_carry_values(rows, load, made);
    return SB_OK;
}

static sb_result sbi_live_carry_load(sbi_live_rows *rows, const sbi_load *load, sb_error *error)
{
    sb_body *next = rows->next;
    sbi_load *made = next->loads + next->load_count;
    sb_result result = sbi_live_rows_room(rows, 0) ? SB_OK : sbi_live_rows_no_memory(error);
    if (result == SB_OK)
        sbi_live_rows_clear(rows);
    for (int j = 0; j < load->row_count && result == SB_OK; j++)
        result = sbi_load_has_faces(load) ? sbi_live_carry_face(rows, load->nodes + load->row_start[j],
                                                                load->row_start[j + 1] - load->row_start[j], error)
                                          : sbi_live_carry_row(rows, load, j, error);
    if (result == SB_OK && rows->rows == 0 && !rows->body->live->erodes)
        result = sbi_fail_node(error, SB_ERROR_ARGUMENT, load->nodes[0],
                               "load %d would lose its last face: remove it first", load->id);
    if (result == SB_OK)
        result = sbi_live_make_load(rows, load, made, error);
    if (result != SB_OK)
        return result;
    next->load_count++;
    return sbi_load_has_faces(load) ? SB_OK : sbi_load_couple(next, made, error);
}

/* ---- tractions ---- */

/* Takes the forces of a traction over to the parts of its face, which the rows list. Where they are not all of it, as
 * in changes other than cuts, the forces stay with their nodes, unless the rest was taken out. */
static void sbi_live_move_traction(const sbi_live_rows *rows, const sbi_traction *traction)
{
    const sb_real close = (sb_real)1e-4;
    sb_body *next = rows->next;
    const int count = sbi_piece_face_nodes(rows->change->nodes_per_cell);
    sbi_traction part = *traction;
    sb_real left = sbi_live_face_share(rows->body, traction->nodes, count);
    for (int j = 0; j < rows->rows; j++)
        left -= sbi_live_face_share(next, rows->nodes + rows->start[j], count);
    if (!(sb_abs(left) < close || rows->body->live->erodes) || sbi_live_loses_node(rows, traction->nodes, count))
        return;
    part.stress = sb_v3_scale(-1, part.stress);
    sbi_body_spread_traction(rows->body, &part, next->dead_load);
    part.stress = traction->stress;
    for (int j = 0; j < rows->rows; j++) {
        memcpy(part.nodes, rows->nodes + rows->start[j], (size_t)count * sizeof *part.nodes);
        sbi_body_spread_traction(next, &part, next->dead_load);
        next->tractions[next->traction_count++] = part;
    }
}

/* Tractions follow the parts of their faces where cuts part them. */
static sb_result sbi_live_carry_tractions(sbi_live_rows *rows, sb_error *error)
{
    const sb_body *body = rows->body;
    const int count = sbi_piece_face_nodes(rows->change->nodes_per_cell);
    sb_result result = SB_OK;
    for (int i = 0; i < body->traction_count && result == SB_OK; i++) {
        const sbi_traction *traction = body->tractions + i;
        if (sbi_live_removed_cell(rows->change, traction->nodes, count) < 0) {
            result = sbi_body_reserve_tractions(rows->next, body->traction_count - i, error);
            if (result == SB_OK)
                rows->next->tractions[rows->next->traction_count++] = *traction;
            continue;
        }
        if (!sbi_live_rows_room(rows, 0))
            return sbi_live_rows_no_memory(error);
        sbi_live_rows_clear(rows);
        result = sbi_live_carry_face(rows, traction->nodes, count, error);
        if (result == SB_OK)
            result = sbi_body_reserve_tractions(rows->next, rows->rows + 1, error);
        if (result == SB_OK)
            sbi_live_move_traction(rows, traction);
    }
    return result;
}

/* ---- constraints ---- */

/* One equation with the heirs of its masters; the terms go to the row at work as unknowns. */
static sb_result sbi_live_carry_equation(sbi_live_rows *rows, const sbi_equations *from, int c, sbi_equations *to,
                                         sb_error *error)
{
    const sbi_mesh_change *change = rows->change;
    int end = to->start[c];
    for (int k = from->start[c]; k < from->start[c + 1]; k++) {
        int node = from->dof[k] / 3, axis = from->dof[k] % 3, r = rows->removed_of[node];
        int first = r < 0 ? 0 : change->heir_start[r], last = r < 0 ? 1 : change->heir_start[r + 1];
        if (r >= 0 && (k == from->start[c] || first == last))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, node,
                                 k == from->start[c] ? "node %d, which goes, is the slave of constraint %d"
                                                     : "node %d, which goes and has no heir, is in constraint %d",
                                 node, from->id[c]);
        for (int h = first; h < last; h++) {
            int dof = 3 * (r < 0 ? node : change->heirs[h]) + axis, at = to->start[c];
            sb_real coefficient = r < 0 ? from->coefficient[k] : from->coefficient[k] * change->heir_weights[h];
            while (at < end && to->dof[at] != dof)
                at++;
            if (at == end) {
                to->dof[end] = dof;
                to->coefficient[end++] = 0;
            }
            to->coefficient[at] += coefficient;
        }
    }
    to->start[c + 1] = end;
    return SB_OK;
}

/* Upper bound of the terms once heirs stand for their nodes. */
static size_t sbi_live_count_terms(const sbi_live_rows *rows, const sbi_equations *from)
{
    size_t terms = 0;
    for (int k = 0; k < from->start[from->count]; k++) {
        int r = rows->removed_of[from->dof[k] / 3];
        terms += r < 0 ? 1 : (size_t)(rows->change->heir_start[r + 1] - rows->change->heir_start[r]);
    }
    return terms + 1;
}

static sb_result sbi_live_carry_constraints(sbi_live_rows *rows, sb_error *error)
{
    const sbi_elimination *elimination = rows->body->elimination;
    sb_body *next = rows->next;
    sbi_elimination_setup setup;
    sbi_equations made;
    sbi_body_rows ties;
    sb_result result = SB_OK;
    if (!elimination)
        return SB_OK;
    if (!sbi_equations_allocate(&next->allocator, elimination->equations.count,
                                sbi_live_count_terms(rows, &elimination->equations), &made))
        return sbi_live_rows_no_memory(error);
    for (int c = 0; c < made.count && result == SB_OK; c++) {
        made.id[c] = elimination->equations.id[c];
        made.value[c] = elimination->equations.value[c];
        result = sbi_live_carry_equation(rows, &elimination->equations, c, &made, error);
    }
    ties.count = made.count;
    ties.start = made.start;
    ties.nodes = NULL;
    ties.dofs = made.dof;
    ties.weights = made.coefficient;
    if (result == SB_OK)
        result = sbi_body_reserve_ties(next, &ties, error);
    setup = sbi_body_elimination_setup(next, &next->matrix);
    if (result == SB_OK)
        result = sbi_elimination_create(&setup, &made, &next->elimination, error);
    if (result != SB_OK) {
        sbi_equations_free(&made);
        return result;
    }
    memcpy(next->elimination->force, elimination->force, (size_t)elimination->equations.count * sizeof(sb_real));
    sbi_precond_set_memory(next->elimination->precond, sbi_precond_get_memory(elimination->precond));
    return SB_OK;
}

SBI_API sb_result sbi_live_carry_rows(const sb_body *body, const sbi_mesh_change *change, sb_body *next,
                                      sb_error *error)
{
    sbi_live_rows rows;
    sb_result result = SB_OK;
    next->last_load_id = body->last_load_id;
    next->next_constraint = body->next_constraint;
    if (!body->load_count && !body->elimination && !body->traction_count)
        return SB_OK;
    memset(&rows, 0, sizeof rows);
    rows.body = body;
    rows.change = change;
    rows.next = next;
    next->loads = (sbi_load *)sbi_alloc_zeroed(&next->allocator, (size_t)body->load_count + 1, sizeof(sbi_load));
    next->load_capacity = next->loads ? body->load_count + 1 : 0;
    if (!next->loads || !sbi_live_rows_begin(&rows))
        result = sbi_live_rows_no_memory(error);
    for (int i = 0; i < body->load_count && result == SB_OK; i++)
        result = sbi_live_carry_load(&rows, body->loads + i, error);
    if (result == SB_OK && body->traction_count)
        result = sbi_live_carry_tractions(&rows, error);
    if (result == SB_OK)
        result = sbi_live_carry_constraints(&rows, error);
    sbi_live_rows_end(&rows);
    return result;
}
