/* sparse_live: rows with room, counted couplings, parts that follow. */
#include "sparse_live.h"

#include <limits.h>
#include <string.h>

enum {
    SBI_LIVE_LOSER = 2,    /* mark of a row that lost a coupling in the change at hand */
    SBI_LIVE_SCATTERED = 4 /* rows are pushed together when more than this part of them, the fourth, have moved */
};

/* ---- memory -------------------------------------------------------------------------------------------- */

/* Takes the arrays of rows from the arena, measuring or for real. */
static void sbi_live_layout_rows(sb_matrix *matrix, sbi_matrix_live *live, size_t rows, sbi_arena *arena)
{
    size_t parts = (size_t)sbi_matrix_most_parts((int)rows) + 1;
    matrix->row_start = (int *)sbi_arena_take(arena, rows + 1, sizeof(int));
    matrix->row_end = (int *)sbi_arena_take(arena, rows, sizeof(int));
    matrix->diagonal = (int *)sbi_arena_take(arena, rows, sizeof(int));
    matrix->part_rows = (int *)sbi_arena_take(arena, rows, sizeof(int));
    matrix->part_start = (int *)sbi_arena_take(arena, parts, sizeof(int));
    live->part_first = (int *)sbi_arena_take(arena, parts, sizeof(int));
    live->room = (int *)sbi_arena_take(arena, rows, sizeof(int));
    live->touched = (int *)sbi_arena_take(arena, rows, sizeof(int));
    live->part_of = (int *)sbi_arena_take(arena, rows, sizeof(int));
    live->lost = (int *)sbi_arena_take(arena, rows, sizeof(int));
    live->held = (int *)sbi_arena_take(arena, rows, sizeof(int));
    live->seen = (int *)sbi_arena_take(arena, rows, sizeof(int));
    matrix->fixed = (unsigned char *)sbi_arena_take(arena, rows, 1);
    live->in_use = (unsigned char *)sbi_arena_take(arena, rows, 1);
    live->marks = (unsigned char *)sbi_arena_take(arena, rows, 1);
}

/* The same for those of blocks, with one sb_real to spare behind them and more. */
static void sbi_live_layout_pool(sb_matrix *matrix, sbi_matrix_live *live, size_t blocks, sbi_arena *arena)
{
    matrix->blocks = (sb_real(*)[9])sbi_arena_take(arena, blocks + 1, sizeof matrix->blocks[0]);
    matrix->columns = (int *)sbi_arena_take(arena, blocks, sizeof(int));
    matrix->transpose = (int *)sbi_arena_take(arena, blocks, sizeof(int));
    live->uses = (int *)sbi_arena_take(arena, blocks, sizeof(int));
    live->heads = (int *)sbi_arena_take(arena, blocks, sizeof(int));
    live->places = (int *)sbi_arena_take(arena, blocks, sizeof(int));
}

typedef void sbi_live_layout(sb_matrix *matrix, sbi_matrix_live *live, size_t count, sbi_arena *arena);

/* Zeroed arrays of so many rows or blocks, 64-byte aligned; what has to be freed later, or NULL. */
static void *sbi_live_take(sb_matrix *matrix, sbi_matrix_live *live, int count, sbi_live_layout *layout)
{
    sbi_arena arena = {NULL, 0, 0};
    unsigned char *memory;
    layout(matrix, live, (size_t)count, &arena);
    if (arena.overflow || arena.used > (size_t)-1 - 64)
        return NULL;
    memory = (unsigned char *)sbi_alloc_zeroed(&matrix->allocator, arena.used + 64, 1);
    if (!memory)
        return NULL;
    arena.base = memory + (64 - (uintptr_t)memory % 64) % 64;
    arena.used = 0;
    layout(matrix, live, (size_t)count, &arena);
    return memory;
}

/* Capacity for `least`: half as much again, as far as int goes. */
static int sbi_live_more(int least) { return least > INT_MAX / 3 * 2 ? INT_MAX : least + least / 2; }

static void sbi_live_copy_rows(const sb_matrix *from, const sbi_matrix_live *old, sb_matrix *to, sbi_matrix_live *live)
{
    size_t ints = (size_t)from->row_count * sizeof(int);
    memcpy(to->row_start, from->row_start, ints);
    memcpy(to->row_end, from->row_end, ints);
    memcpy(to->diagonal, from->diagonal, ints);
    memcpy(to->part_rows, from->part_rows, ints);
    memcpy(to->part_start, from->part_start, ((size_t)from->part_count + 1) * sizeof(int));
    memcpy(to->fixed, from->fixed, (size_t)from->row_count);
    if (!old)
        return;
    memcpy(live->room, old->room, ints);
    memcpy(live->part_of, old->part_of, ints);
    memcpy(live->part_first, old->part_first, (size_t)from->part_count * sizeof(int));
    memcpy(live->in_use, old->in_use, (size_t)from->row_count);
}

static int sbi_live_grow_rows(sb_matrix *matrix, int rows)
{
    sb_matrix grown = *matrix;
    sbi_matrix_live live = *matrix->live;
    void *memory = sbi_live_take(&grown, &live, rows, sbi_live_layout_rows);
    if (!memory)
        return 0;
    sbi_live_copy_rows(matrix, matrix->live, &grown, &live);
    sbi_free(&matrix->allocator, live.row_memory);
    live.row_memory = memory;
    live.row_capacity = rows;
    *matrix->live = live;
    *matrix = grown;
    return 1;
}

static void sbi_live_copy_pool(const sb_matrix *from, sb_matrix *to)
{
    memcpy(to->blocks, from->blocks, (size_t)from->block_count * sizeof from->blocks[0]);
    memcpy(to->columns, from->columns, (size_t)from->block_count * sizeof(int));
    memcpy(to->transpose, from->transpose, (size_t)from->block_count * sizeof(int));
}

static int sbi_live_grow_pool(sb_matrix *matrix, int blocks)
{
    sb_matrix grown = *matrix;
    sbi_matrix_live live = *matrix->live;
    void *memory = sbi_live_take(&grown, &live, blocks, sbi_live_layout_pool);
    if (!memory)
        return 0;
    sbi_live_copy_pool(matrix, &grown);
    memcpy(live.uses, matrix->live->uses, (size_t)matrix->block_count * sizeof(int));
    memcpy(live.heads, matrix->live->heads, (size_t)matrix->block_count * sizeof(int));
    sbi_free(&matrix->allocator, live.pool_memory);
    live.pool_memory = memory;
    live.block_capacity = blocks;
    *matrix->live = live;
    *matrix = grown;
    return 1;
}

SBI_API int sbi_matrix_capacity(const sb_matrix *matrix)
{
    return matrix->live ? matrix->live->block_capacity : matrix->block_count;
}

SBI_API int sbi_matrix_row_capacity(const sb_matrix *matrix)
{
    return matrix->live ? matrix->live->row_capacity : matrix->row_count;
}

SBI_API unsigned sbi_matrix_version(const sb_matrix *matrix) { return matrix->live ? matrix->live->version : 0; }

SBI_API int sbi_matrix_used_blocks(const sb_matrix *matrix)
{
    return matrix->live ? matrix->live->used_blocks : matrix->block_count;
}

/* ---- places of the pool --------------------------------------------------------------------------------- */

/* A coupling that nothing is known of yet. */
static void sbi_live_set(sb_matrix *matrix, int place, int column, int uses)
{
    matrix->columns[place] = column;
    matrix->transpose[place] = place;
    matrix->live->uses[place] = uses;
    matrix->live->heads[place] = -1;
}

/* Leaves a place to no row. */
static void sbi_live_clear(sb_matrix *matrix, int place) { sbi_live_set(matrix, place, 0, 0); }

/* Brings a coupling of row i to another place. */
static void sbi_live_move(sb_matrix *matrix, int i, int from, int to)
{
    int twin = matrix->transpose[from];
    matrix->columns[to] = matrix->columns[from];
    matrix->live->uses[to] = matrix->live->uses[from];
    matrix->live->heads[to] = matrix->live->heads[from];
    if (matrix->columns[to] == i) {
        matrix->diagonal[i] = matrix->transpose[to] = to;
        return;
    }
    matrix->transpose[to] = twin;
    matrix->transpose[twin] = to;
}

static int sbi_live_piece_places(int length) { return (length + SBI_LIVE_PIECE - 1) / SBI_LIVE_PIECE * SBI_LIVE_PIECE; }

/* A piece for a row of so many blocks; its places are cleared. */
static void sbi_live_take_piece(sb_matrix *matrix, int i, int length)
{
    sbi_matrix_live *live = matrix->live;
    int places = sbi_live_piece_places(length), size = places / SBI_LIVE_PIECE - 1, start;
    start = size < SBI_LIVE_PIECE_SIZES ? live->free_pieces[size] : -1;
    if (start >= 0) {
        live->free_pieces[size] = live->uses[start];
        live->uses[start] = 0;
    } else {
        start = matrix->block_count;
        matrix->block_count += places; /* there is room: sbi_matrix_reserve has seen to it */
        for (int k = start; k < matrix->block_count; k++)
            sbi_live_clear(matrix, k);
    }
    matrix->row_start[i] = matrix->row_end[i] = start;
    live->room[i] = places;
}

/* Gives a piece back whose places are cleared. What is larger than the largest size, or smaller than the smallest,
 * waits for the rows to be pushed together. */
static void sbi_live_give_piece(sb_matrix *matrix, int start, int places)
{
    sbi_matrix_live *live = matrix->live;
    int size = places / SBI_LIVE_PIECE - 1;
    if (size < 0 || size >= SBI_LIVE_PIECE_SIZES)
        return;
    live->uses[start] = live->free_pieces[size];
    live->free_pieces[size] = start;
}

/* A row of its diagonal block only, 0. */
static void sbi_live_open_row(sb_matrix *matrix, int i)
{
    sbi_live_take_piece(matrix, i, 1);
    matrix->diagonal[i] = matrix->row_start[i];
    matrix->columns[matrix->row_start[i]] = i;
    matrix->row_end[i] = matrix->row_start[i] + 1;
    matrix->fixed[i] = 0;
    matrix->live->used_blocks++;
    matrix->live->alone_count++;
    matrix->live->in_use[i] = 0;
    matrix->live->part_of[i] = -1;
}

static int sbi_live_is_alone(const sb_matrix *matrix, int i) { return matrix->row_end[i] - matrix->row_start[i] == 1; }

/* Lists a row among those of the change at hand, before its blocks change; it counts as alone again in
 * sbi_live_end_nodes. */
static void sbi_live_touch(sb_matrix *matrix, int i)
{
    sbi_matrix_live *live = matrix->live;
    if (!live->marks[i]) {
        live->marks[i] = 1;
        live->alone_count -= sbi_live_is_alone(matrix, i);
        live->lost[i] = i;
        live->touched[live->touched_count++] = i;
    }
}

/* ---- pushing rows together ------------------------------------------------------------------------------ */

/* Where each place of the pool goes when rows follow each other, as long as they are. Returns where they end. */
static int sbi_live_plan_places(const sb_matrix *matrix)
{
    int *to = matrix->live->places, end = 0;
    for (int i = 0; i < matrix->row_count; i++)
        for (int q = matrix->row_start[i]; q < matrix->row_end[i]; q++)
            to[q] = end++;
    return end;
}

/* Brings what an array has of the rows together, by way of the blocks, whose values are nobody's. */
static void sbi_live_pack_array(sb_matrix *matrix, int *array)
{
    unsigned char *packed = (unsigned char *)matrix->blocks;
    size_t bytes = 0;
    for (int i = 0; i < matrix->row_count; i++) {
        size_t more = (size_t)(matrix->row_end[i] - matrix->row_start[i]) * sizeof *array;
        memcpy(packed + bytes, array + matrix->row_start[i], more);
        bytes += more;
    }
    memcpy(array, packed, bytes);
}

/* Pushes rows together in their order, so that loops over them run through memory as in a compact matrix. */
static void sbi_live_pack(sb_matrix *matrix)
{
    sbi_matrix_live *live = matrix->live;
    int end = sbi_live_plan_places(matrix), at = 0;
    for (int i = 0; i < matrix->row_count; i++)
        for (int q = matrix->row_start[i]; q < matrix->row_end[i]; q++)
            matrix->transpose[q] = live->places[matrix->transpose[q]];
    sbi_live_pack_array(matrix, matrix->columns);
    sbi_live_pack_array(matrix, matrix->transpose);
    sbi_live_pack_array(matrix, live->uses);
    sbi_live_pack_array(matrix, live->heads);
    for (int i = 0; i < matrix->row_count; i++) {
        matrix->diagonal[i] = live->places[matrix->diagonal[i]];
        live->room[i] = matrix->row_end[i] - matrix->row_start[i];
        matrix->row_start[i] = at;
        matrix->row_end[i] = at += live->room[i];
    }
    for (int q = end; q < matrix->block_count; q++)
        sbi_live_clear(matrix, q);
    for (int size = 0; size < SBI_LIVE_PIECE_SIZES; size++)
        live->free_pieces[size] = -1;
    matrix->block_count = live->packed_end = end;
    live->moved_count = 0;
    live->repacked = 1;
}

/* 1 when so many rows lie elsewhere that products, which read the pool, take longer than they need. */
static int sbi_live_is_scattered(const sb_matrix *matrix)
{
    return matrix->live->moved_count > matrix->row_count / SBI_LIVE_SCATTERED;
}

/* ---- the plan: couplings that change --------------------------------------------------------------------- */

/* Adds to what a pair of nodes changes by; of most pairs of a changed cell nothing is left in the end. */
static void sbi_live_plan_pair(sbi_matrix_live *live, int i, int j, int uses)
{
    int low = sbi_min_int(i, j), high = sbi_max_int(i, j), at = live->held[low];
    sbi_live_pair *pair;
    if (i == j)
        return;
    while (at >= 0 && live->pairs[at].high != high)
        at = live->pairs[at].next;
    if (at >= 0) {
        live->pairs[at].uses += uses;
        return;
    }
    pair = live->pairs + live->pair_count;
    pair->low = low;
    pair->high = high;
    pair->uses = uses;
    pair->next = live->held[low];
    live->held[low] = live->pair_count++;
}

/* The same for all pairs of cells, but, with `marked` 0, those of marked nodes. */
static void sbi_live_plan_cells(sbi_matrix_live *live, int count, int n, const int *cells, int uses, int marked)
{
    for (int c = 0; c < count; c++, cells += n)
        for (int a = 0; a < n; a++)
            for (int b = a + 1; b < n && (marked || !live->marks[cells[a]]); b++)
                if (marked || !live->marks[cells[b]])
                    sbi_live_plan_pair(live, cells[a], cells[b], uses);
}

/* No pairs yet with any of these nodes. */
static void sbi_live_plan_nodes(sbi_matrix_live *live, size_t count, const int *nodes)
{
    for (size_t k = 0; k < count; k++)
        live->held[nodes[k]] = -1;
}

/* All pairs of a change. Couplings of nodes that it removes go with these; theirs are not counted. */
static void sbi_live_plan_pairs(sbi_matrix_live *live, const sbi_mesh_change *change,
                                const sbi_matrix_couplings *others)
{
    live->pair_count = 0;
    if (others) {
        sbi_live_plan_nodes(live, 2 * (size_t)others->gone_count, others->gone);
        sbi_live_plan_nodes(live, 2 * (size_t)others->made_count, others->made);
    }
    if (change) {
        int n = change->nodes_per_cell;
        sbi_live_plan_nodes(live, (size_t)change->removed_cell_count * (size_t)n, change->removed_cell_nodes);
        sbi_live_plan_nodes(live, (size_t)change->made_cell_count * (size_t)n, change->made_cell_nodes);
        for (int k = 0; k < change->removed_node_count; k++)
            live->marks[change->removed_nodes[k]] = 1;
        sbi_live_plan_cells(live, change->removed_cell_count, n, change->removed_cell_nodes, -1, 0);
        for (int k = 0; k < change->removed_node_count; k++)
            live->marks[change->removed_nodes[k]] = 0;
        sbi_live_plan_cells(live, change->made_cell_count, n, change->made_cell_nodes, 1, 1);
    }
    for (int k = 0; others && k < others->gone_count; k++)
        sbi_live_plan_pair(live, others->gone[2 * (size_t)k], others->gone[2 * (size_t)k + 1], -1);
    for (int k = 0; others && k < others->made_count; k++)
        sbi_live_plan_pair(live, others->made[2 * (size_t)k], others->made[2 * (size_t)k + 1], 1);
}

/* Leaves the pairs whose coupling is there and changes; *made: how many more are new, behind them. */
static void sbi_live_sort_pairs(const sb_matrix *matrix, int *made)
{
    sbi_matrix_live *live = matrix->live;
    int count = 0, end = 0;
    for (int k = 0; k < live->pair_count; k++) {
        sbi_live_pair pair = live->pairs[k];
        if (pair.uses == 0)
            continue;
        pair.places[0] = sb_matrix_find(matrix, pair.low, pair.high);
        live->pairs[end] = pair;
        if (pair.places[0] >= 0) {
            live->pairs[end] = live->pairs[count];
            live->pairs[count++] = pair;
        }
        end++;
    }
    live->pair_count = count;
    *made = end - count;
}

/* The keys of new couplings, row after row, columns ascending in each. */
static void sbi_live_list_keys(sbi_matrix_live *live, int made)
{
    const sbi_live_pair *pairs = live->pairs + live->pair_count;
    int *rows = live->lost, *starts = live->held, *ends = live->seen, row_count = 0, end = 0;
    for (int k = 0; k < made; k++)
        ends[pairs[k].low] = ends[pairs[k].high] = 0;
    for (int k = 0; k < 2 * made; k++) {
        int i = k % 2 ? pairs[k / 2].high : pairs[k / 2].low;
        if (ends[i]++ == 0)
            rows[row_count++] = i;
    }
    for (int k = 0; k < row_count; k++) {
        starts[rows[k]] = end;
        end += ends[rows[k]];
        ends[rows[k]] = starts[rows[k]];
    }
    for (int k = 0; k < 2 * made; k++) {
        const sbi_live_pair *pair = pairs + k / 2;
        int i = k % 2 ? pair->high : pair->low, j = k % 2 ? pair->low : pair->high, at = ends[i]++;
        for (; at > starts[i] && live->keys[at - 1].column > j; at--)
            live->keys[at] = live->keys[at - 1];
        live->keys[at].row = i;
        live->keys[at].column = j;
        live->keys[at].uses = pair->uses;
        live->keys[at].pair = live->pair_count + k / 2;
    }
    live->key_count = end;
}

/* Room for `count` items, whose old ones nobody needs any more: *items, or a larger one in its place. NULL: no memory.
 */
static void *sbi_live_renew(const sb_allocator *allocator, void *items, int *capacity, size_t count, size_t size)
{
    int more = sbi_live_more((int)count);
    void *made;
    if (items && count <= (size_t)*capacity)
        return items;
    made = sbi_alloc(allocator, (size_t)more, size);
    if (!made)
        return NULL;
    sbi_free(allocator, items);
    *capacity = more;
    return made;
}

/* Room for so many keys and pairs; 0: no memory. */
static int sbi_live_take_plan(sb_matrix *matrix, size_t key_count, size_t pair_count)
{
    sbi_matrix_live *live = matrix->live;
    void *keys, *pairs;
    if (key_count > INT_MAX / 2 || pair_count > INT_MAX / 2)
        return 0;
    keys = sbi_live_renew(&matrix->allocator, live->keys, &live->key_capacity, key_count, sizeof *live->keys);
    live->keys = keys ? (sbi_live_key *)keys : live->keys;
    pairs = sbi_live_renew(&matrix->allocator, live->pairs, &live->pair_capacity, pair_count, sizeof *live->pairs);
    live->pairs = pairs ? (sbi_live_pair *)pairs : live->pairs;
    return keys && pairs;
}

SBI_API sb_result sbi_matrix_reserve_plan(sb_matrix *matrix, int couplings, sb_error *error)
{
    return sbi_live_take_plan(matrix, (size_t)couplings, (size_t)couplings)
               ? SB_OK
               : sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d new couplings", couplings);
}

/* Fills the plan, with rows for all nodes there; 0: no memory. */
static int sbi_live_plan(sb_matrix *matrix, const sbi_mesh_change *change, const sbi_matrix_couplings *others)
{
    sbi_matrix_live *live = matrix->live;
    size_t n = change ? (size_t)change->nodes_per_cell : 0, each = n > 0 ? n * (n - 1) / 2 : 0, pairs, keys;
    int made;
    keys = 2 * each * (change ? (size_t)change->made_cell_count : 0) + 2 * (size_t)(others ? others->made_count : 0);
    pairs = each * (change ? (size_t)change->made_cell_count + (size_t)change->removed_cell_count : 0) +
            (others ? (size_t)others->made_count + (size_t)others->gone_count : 0);
    if (!sbi_live_take_plan(matrix, keys, pairs))
        return 0;
    sbi_live_plan_pairs(live, change, others);
    sbi_live_sort_pairs(matrix, &made);
    sbi_live_list_keys(live, made);
    return 1;
}

/* Places that the plan takes at the pool's end at most. */
static size_t sbi_live_planned_places(const sb_matrix *matrix, int row_count)
{
    sbi_matrix_live *live = matrix->live;
    size_t places = SBI_LIVE_PIECE * (size_t)sbi_max_int(0, row_count - matrix->row_count);
    for (int k = 0, next; k < live->key_count; k = next) {
        int i = live->keys[k].row, is_new = i >= matrix->row_count;
        int length = is_new ? 1 : matrix->row_end[i] - matrix->row_start[i];
        for (next = k; next < live->key_count && live->keys[next].row == i; next++)
            length++;
        live->longest = sbi_max_int(live->longest, length);
        if (is_new || length > live->room[i])
            places += (size_t)sbi_live_piece_places(length);
    }
    return places;
}

SBI_API sb_result sbi_matrix_reserve(sb_matrix *matrix, const sbi_mesh_change *change,
                                     const sbi_matrix_couplings *others, sb_error *error)
{
    sbi_matrix_live *live = matrix->live;
    int rows = change ? change->node_end : matrix->row_count, made = 1;
    if (rows > live->row_capacity)
        made = sbi_live_grow_rows(matrix, sbi_live_more(rows));
    made = made && sbi_live_plan(matrix, change, others);
    live->pack = 0;
    if (made) {
        size_t more = sbi_live_planned_places(matrix, rows), most = (size_t)live->block_capacity;
        if ((size_t)matrix->block_count + more > most) {
            /* half of what is pushed together stays free, or soon it would have to be done again */
            size_t needed = (size_t)sbi_matrix_used_blocks(matrix) + more;
            live->pack = needed + needed / 8 <= most;
            if (!live->pack)
                made = (size_t)matrix->block_count + more <= INT_MAX &&
                       sbi_live_grow_pool(matrix, sbi_live_more((int)((size_t)matrix->block_count + more)));
        }
    }
    return made ? SB_OK : sbi_fail(error, SB_ERROR_MEMORY, "no memory for a matrix of %d rows to change", rows);
}

/* ---- following ------------------------------------------------------------------------------------------- */

/* The uses of couplings that there are, as planned. */
static void sbi_live_count_planned(sb_matrix *matrix)
{
    const sbi_matrix_live *live = matrix->live;
    for (int k = 0; k < live->pair_count; k++) {
        const sbi_live_pair *pair = live->pairs + k;
        int q = live->repacked ? live->places[pair->places[0]] : pair->places[0];
        live->uses[q] += pair->uses;
        live->uses[matrix->transpose[q]] += pair->uses;
        if (live->uses[q] == 0) {
            sbi_live_touch(matrix, pair->low);
            sbi_live_touch(matrix, pair->high);
        }
    }
}

/* All couplings of a node that goes. */
static void sbi_live_drop_node(sb_matrix *matrix, int i)
{
    sbi_matrix_live *live = matrix->live;
    sbi_live_touch(matrix, i);
    for (int q = matrix->row_start[i]; q < matrix->row_end[i]; q++) {
        live->uses[q] = live->uses[matrix->transpose[q]] = 0;
        sbi_live_touch(matrix, matrix->columns[q]);
    }
    live->in_use[i] = 0;
    if (live->part_of[i] >= 0 && live->part_of[i] != live->alone_part && live->part_first[live->part_of[i]] == i)
        live->first_is_lost = 1;
    live->part_of[i] = -1;
}

static int sbi_live_root(int *parent, int i)
{
    while (parent[i] != i) {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    return i;
}

static void sbi_live_join(int *parent, int i, int j)
{
    i = sbi_live_root(parent, i);
    j = sbi_live_root(parent, j);
    parent[sbi_max_int(i, j)] = sbi_min_int(i, j);
}

/* Takes couplings that nothing needs any more out of a row. */
static void sbi_live_sweep_row(sb_matrix *matrix, int i)
{
    sbi_matrix_live *live = matrix->live;
    int end = matrix->row_start[i];
    for (int q = end; q < matrix->row_end[i]; q++) {
        if (live->uses[q] == 0 && matrix->columns[q] != i) {
            sbi_live_join(live->lost, i, matrix->columns[q]);
            continue;
        }
        if (q != end)
            sbi_live_move(matrix, i, q, end);
        end++;
    }
    if (end < matrix->row_end[i])
        live->marks[i] = SBI_LIVE_LOSER;
    live->used_blocks -= matrix->row_end[i] - end;
    for (int q = end; q < matrix->row_end[i]; q++)
        sbi_live_clear(matrix, q);
    matrix->row_end[i] = end;
}

/* Brings a row to a piece with room for `length` blocks. */
static void sbi_live_move_row(sb_matrix *matrix, int i, int length)
{
    int start = matrix->row_start[i], end = matrix->row_end[i], room = matrix->live->room[i];
    matrix->live->moved_count += start < matrix->live->packed_end;
    sbi_live_take_piece(matrix, i, length);
    for (int q = start; q < end; q++) {
        sbi_live_move(matrix, i, q, matrix->row_end[i]++);
        sbi_live_clear(matrix, q);
    }
    sbi_live_give_piece(matrix, start, room);
}

/* Merges planned couplings, all of row i, into it. */
static void sbi_live_fill_row(sb_matrix *matrix, int i, const sbi_live_key *keys, int count)
{
    sbi_matrix_live *live = matrix->live;
    int length = matrix->row_end[i] - matrix->row_start[i] + count, read, write;
    if (length > live->room[i])
        sbi_live_move_row(matrix, i, length);
    read = matrix->row_end[i] - 1;
    matrix->row_end[i] += count;
    live->used_blocks += count;
    for (write = matrix->row_end[i] - 1; count > 0; write--) {
        const sbi_live_key *key = keys + count - 1;
        if (read >= matrix->row_start[i] && matrix->columns[read] > key->column) {
            sbi_live_move(matrix, i, read--, write);
            continue;
        }
        sbi_live_set(matrix, write, key->column, key->uses);
        live->pairs[key->pair].places[key->row > key->column] = write;
        count--;
    }
}

static void sbi_live_fill(sb_matrix *matrix)
{
    const sbi_matrix_live *live = matrix->live;
    for (int k = 0, next; k < live->key_count; k = next) {
        for (next = k; next < live->key_count && live->keys[next].row == live->keys[k].row; next++)
            continue;
        sbi_live_fill_row(matrix, live->keys[k].row, live->keys + k, next - k);
    }
    for (int k = 0; k < live->key_count / 2; k++) {
        const int *places = live->pairs[live->pair_count + k].places;
        matrix->transpose[places[0]] = places[1];
        matrix->transpose[places[1]] = places[0];
    }
}

/* ---- parts ------------------------------------------------------------------------------------------------ */

/* Joins, in `held`, rows with this mark that are coupled or have a neighbour in common. */
static void sbi_live_join_neighbours(sb_matrix *matrix, int mark)
{
    sbi_matrix_live *live = matrix->live;
    int *owner = live->seen; /* a row that each column is in */
    for (int k = 0; k < live->touched_count; k++) {
        int i = live->touched[k];
        live->held[i] = i;
        for (int q = matrix->row_start[i]; q < matrix->row_end[i] && live->marks[i] >= mark; q++)
            owner[matrix->columns[q]] = -1;
    }
    for (int k = 0; k < live->touched_count; k++) {
        int i = live->touched[k];
        for (int q = matrix->row_start[i]; q < matrix->row_end[i] && live->marks[i] >= mark; q++) {
            int *at = owner + matrix->columns[q];
            if (*at < 0)
                *at = i;
            else
                sbi_live_join(live->held, i, *at);
        }
    }
}

/* Joins, in `held`, rows that lost something and are coupled. */
static void sbi_live_join_losers(sb_matrix *matrix)
{
    sbi_matrix_live *live = matrix->live;
    for (int k = 0; k < live->touched_count; k++)
        live->held[live->touched[k]] = live->touched[k];
    for (int k = 0; k < live->touched_count; k++) {
        int i = live->touched[k];
        if (live->marks[i] != SBI_LIVE_LOSER)
            continue;
        for (int q = matrix->row_start[i]; q < matrix->diagonal[i]; q++)
            if (live->marks[matrix->columns[q]] == SBI_LIVE_LOSER)
                sbi_live_join(live->held, i, matrix->columns[q]);
    }
}

/* 1 when nodes that lost couplings to each other, directly or by way of nodes that are gone, are joined in `held`. */
static int sbi_live_losers_hold(sb_matrix *matrix)
{
    sbi_matrix_live *live = matrix->live;
    for (int k = 0; k < live->touched_count; k++)
        live->seen[live->touched[k]] = -1;
    for (int k = 0; k < live->touched_count; k++) {
        int i = live->touched[k], group, held;
        if (!live->in_use[i] || live->marks[i] != SBI_LIVE_LOSER)
            continue;
        group = sbi_live_root(live->lost, i);
        held = sbi_live_root(live->held, i);
        if (live->seen[group] >= 0 && live->seen[group] != held)
            return 0;
        live->seen[group] = held;
    }
    return 1;
}

/* 1 when no part has come apart; 0: that has to be looked into. Mostly couplings of the rows that lost something to
 * each other are enough to see it, or to neighbours that they have in common. */
static int sbi_live_parts_hold(sb_matrix *matrix)
{
    sbi_live_join_losers(matrix);
    for (int mark = SBI_LIVE_LOSER; !sbi_live_losers_hold(matrix); mark--) {
        if (mark == 0)
            return 0;
        sbi_live_join_neighbours(matrix, mark);
    }
    return 1;
}

/* Gives new nodes the part of a neighbour; 0: there is a new part, or two have met. */
static int sbi_live_parts_extend(sb_matrix *matrix)
{
    sbi_matrix_live *live = matrix->live;
    int open, found;
    do {
        open = found = 0;
        for (int k = 0; k < live->touched_count; k++) {
            int i = live->touched[k];
            if (live->part_of[i] >= 0 || sbi_live_is_alone(matrix, i))
                continue;
            for (int q = matrix->row_start[i]; q < matrix->row_end[i] && live->part_of[i] < 0; q++)
                live->part_of[i] = live->part_of[matrix->columns[q]];
            found |= live->part_of[i] >= 0;
            open |= live->part_of[i] < 0;
        }
    } while (open && found);
    for (int k = 0; k < live->key_count && !open; k++)
        open |= live->part_of[live->keys[k].row] != live->part_of[live->keys[k].column];
    return !open;
}

/* Numbers parts by their first rows, rows with their diagonal block only as one, and lists them. */
static void sbi_live_number_parts(sb_matrix *matrix)
{
    sbi_matrix_live *live = matrix->live;
    int *number = live->held, alone = -1;
    for (int c = 0; c < matrix->row_count; c++)
        number[c] = -1;
    matrix->part_count = 0;
    for (int i = 0; i < matrix->row_count; i++) {
        int *at = sbi_live_is_alone(matrix, i) ? &alone : number + live->part_of[i];
        if (*at < 0)
            *at = matrix->part_count++;
        live->part_of[i] = *at;
    }
    sbi_sparse_list_parts(matrix, live->part_of);
}

/* First rows, from lists that are right. */
static void sbi_live_note_parts(sb_matrix *matrix)
{
    sbi_matrix_live *live = matrix->live;
    live->alone_part = -1;
    live->alone_count = 0;
    for (int c = 0; c < matrix->part_count; c++) {
        live->part_first[c] = matrix->part_rows[matrix->part_start[c]];
        if (!sbi_live_is_alone(matrix, live->part_first[c]))
            continue;
        live->alone_part = c;
        live->alone_count = matrix->part_start[c + 1] - matrix->part_start[c];
    }
    live->listed = 1;
    live->first_is_lost = 0;
}

/* 1 when all parts but that of the rows alone have the first row they had. *alone: the least row that is alone, of
 * those touched, or INT_MAX. */
static int sbi_live_firsts_hold(const sb_matrix *matrix, int *alone)
{
    const sbi_matrix_live *live = matrix->live;
    *alone = INT_MAX;
    if (live->first_is_lost)
        return 0;
    for (int k = 0; k < live->touched_count; k++) {
        int i = live->touched[k], part = live->part_of[i], is_alone = sbi_live_is_alone(matrix, i);
        if (is_alone)
            *alone = sbi_min_int(*alone, i);
        if (part >= 0 && part != live->alone_part &&
            (is_alone ? i == live->part_first[part] : i < live->part_first[part]))
            return 0;
    }
    return 1;
}

/* 1 when the rows alone, if any, stay where they are among the parts: last, or before a part that begins later. first:
 * the least row that is alone now, of those touched. */
static int sbi_live_alone_stay(const sb_matrix *matrix, int others, int first)
{
    const sbi_matrix_live *live = matrix->live;
    int old = live->alone_part >= 0 && live->alone_part < others ? live->part_first[live->alone_part] : -1;
    if (old >= 0)
        return old < matrix->row_count && sbi_live_is_alone(matrix, old) && first >= old;
    return others == 0 || first > live->part_first[others - 1];
}

/* Where parts keep their numbers only rows that were touched get theirs. 0: they do not, and nothing has changed. */
static int sbi_live_keep_numbers(sb_matrix *matrix)
{
    sbi_matrix_live *live = matrix->live;
    int first, others = matrix->part_count - (live->alone_part >= 0);
    if (!sbi_live_firsts_hold(matrix, &first) || !sbi_live_alone_stay(matrix, others, first))
        return 0;
    if (live->alone_part < 0 || live->alone_part == others) {
        live->alone_part = live->alone_count ? others : -1;
        matrix->part_count = others + (live->alone_count > 0);
    }
    for (int k = 0; k < live->touched_count; k++)
        if (sbi_live_is_alone(matrix, live->touched[k]))
            live->part_of[live->touched[k]] = live->alone_part;
    live->listed = 0;
    return 1;
}

SBI_API void sbi_matrix_list_parts(const sb_matrix *matrix)
{
    if (!matrix->live || matrix->live->listed)
        return;
    sbi_sparse_list_parts(matrix, matrix->live->part_of);
    matrix->live->listed = 1;
}

static void sbi_live_follow_parts(sb_matrix *matrix)
{
    int holds = sbi_live_parts_hold(matrix) && sbi_live_parts_extend(matrix);
    matrix->live->renumbered = !holds || !sbi_live_keep_numbers(matrix);
    if (!matrix->live->renumbered)
        return;
    if (holds)
        sbi_live_number_parts(matrix);
    else
        sbi_sparse_find_parts(matrix, matrix->live->part_of);
    sbi_live_note_parts(matrix);
}

/* ---- all of it --------------------------------------------------------------------------------------------- */

static void sbi_live_begin(sb_matrix *matrix)
{
    sbi_matrix_live *live = matrix->live;
    live->touched_count = 0;
    live->repacked = 0;
    if (live->pack)
        sbi_live_pack(matrix);
    live->pack = 0;
}

/* Nodes that go, rows that begin, nodes that come. */
static void sbi_live_follow_nodes(sb_matrix *matrix, const sbi_mesh_change *change)
{
    sbi_matrix_live *live = matrix->live;
    for (int k = 0; k < change->removed_node_count; k++)
        sbi_live_drop_node(matrix, change->removed_nodes[k]);
    for (; matrix->row_count < change->node_end; matrix->row_count++) {
        sbi_live_open_row(matrix, matrix->row_count);
        sbi_live_touch(matrix, matrix->row_count); /* its slot may stay free */
    }
    for (int k = 0; k < change->made_node_count; k++) {
        int i = change->made_nodes[k];
        sbi_live_touch(matrix, i);
        matrix->fixed[i] = 0;
        live->in_use[i] = 1;
        live->part_of[i] = -1;
    }
}

/* Rows beyond the last node go; rows of nodes that are gone have their diagonal block only. */
static void sbi_live_end_nodes(sb_matrix *matrix, const sbi_mesh_change *change)
{
    sbi_matrix_live *live = matrix->live;
    while (matrix->row_count > change->node_end) {
        int i = --matrix->row_count;
        live->alone_count -= !live->marks[i];
        live->used_blocks--;
        sbi_live_clear(matrix, matrix->row_start[i]);
        sbi_live_give_piece(matrix, matrix->row_start[i], live->room[i]);
    }
    for (int k = live->touched_count; k-- > 0;) {
        int i = live->touched[k];
        if (i >= matrix->row_count) {
            live->marks[i] = 0;
            live->touched[k] = live->touched[--live->touched_count];
            continue;
        }
        live->alone_count += sbi_live_is_alone(matrix, i);
        if (!live->in_use[i])
            sbi_matrix_set_free_row(matrix, i);
    }
}

/* 0: the change was of none but places of nodes: no block and no row has come, gone or moved, or may have. */
static int sbi_live_pattern_differs(const sb_matrix *matrix, int rows_before)
{
    const sbi_matrix_live *live = matrix->live;
    return live->touched_count > 0 || live->pair_count > 0 || live->key_count > 0 || live->repacked ||
           matrix->row_count != rows_before;
}

SBI_API void sbi_matrix_follow(sb_matrix *matrix, const sbi_mesh_change *change)
{
    sbi_mesh_change same;
    sbi_matrix_live *live = matrix->live;
    int rows;
    memset(&same, 0, sizeof same);
    same.node_end = matrix->row_count;
    change = change ? change : &same;
    rows = matrix->row_count;
    sbi_live_begin(matrix);
    sbi_live_follow_nodes(matrix, change);
    sbi_live_count_planned(matrix);
    for (int k = 0; k < live->key_count; k++)
        sbi_live_touch(matrix, live->keys[k].row);
    for (int k = 0; k < live->touched_count; k++)
        sbi_live_sweep_row(matrix, live->touched[k]);
    sbi_live_fill(matrix);
    if (sbi_live_is_scattered(matrix))
        sbi_live_pack(matrix);
    for (int i = 0; i < matrix->row_count && live->repacked; i++)
        sbi_live_touch(matrix, i);
    sbi_live_end_nodes(matrix, change);
    sbi_live_follow_parts(matrix);
    live->version += (unsigned)sbi_live_pattern_differs(matrix, rows);
    for (int k = 0; k < live->touched_count; k++)
        live->marks[live->touched[k]] = 0;
    live->key_count = live->pair_count = 0;
}

/* ---- making one -------------------------------------------------------------------------------------------- */

/* Takes over rows and blocks of a compact matrix. */
static int sbi_live_take_over(sb_matrix *matrix, sbi_matrix_live *live, int rows, int blocks)
{
    sb_matrix made = *matrix;
    live->row_capacity = rows;
    live->block_capacity = blocks;
    live->version = 1;
    live->row_memory = sbi_live_take(&made, live, rows, sbi_live_layout_rows);
    live->pool_memory = live->row_memory ? sbi_live_take(&made, live, blocks, sbi_live_layout_pool) : NULL;
    if (!live->pool_memory) {
        sbi_free(&matrix->allocator, live->row_memory);
        return 0;
    }
    sbi_live_copy_rows(matrix, NULL, &made, live);
    sbi_live_copy_pool(matrix, &made);
    for (int q = 0; q < matrix->block_count; q++)
        live->heads[q] = -1;
    for (int i = 0; i < matrix->row_count; i++) {
        live->room[i] = made.row_end[i] - made.row_start[i];
        live->longest = sbi_max_int(live->longest, live->room[i]);
    }
    for (int c = 0; c < matrix->part_count; c++)
        for (int k = matrix->part_start[c]; k < matrix->part_start[c + 1]; k++)
            live->part_of[matrix->part_rows[k]] = c;
    for (int size = 0; size < SBI_LIVE_PIECE_SIZES; size++)
        live->free_pieces[size] = -1;
    sbi_free(&matrix->allocator, made.memory);
    made.memory = NULL;
    made.live = live;
    live->used_blocks = live->packed_end = made.block_count;
    *matrix = made;
    sbi_live_note_parts(matrix);
    return 1;
}

static int sbi_live_capacity(int count, double slack)
{
    double capacity = (double)count * (1 + slack);
    return capacity < (double)INT_MAX ? (int)capacity : INT_MAX;
}

/* Blocks of a matrix with slack: a quarter more, so that rows can be pushed together instead of a pool made anew, until
 * nodes and cells have used up the slack. */
static int sbi_live_pool_capacity(int blocks, double slack)
{
    return sbi_live_capacity(blocks, slack > 0 ? 1.25 * (1 + slack) - 1 : 0);
}

/* One use more of a coupling, if the matrix has it. */
static void sbi_live_count(const sb_matrix *matrix, int i, int j)
{
    int q = i == j ? -1 : sb_matrix_find(matrix, i, j);
    if (q < 0)
        return;
    matrix->live->uses[q]++;
    matrix->live->uses[matrix->transpose[q]]++;
}

SBI_API sb_result sbi_matrix_make_live(sb_matrix *matrix, int cell_count, int nodes_per_cell, const int *cells,
                                       const sbi_matrix_couplings *others, const unsigned char *in_use, double slack,
                                       sb_error *error)
{
    sbi_matrix_live *live = (sbi_matrix_live *)sbi_alloc_zeroed(&matrix->allocator, 1, sizeof *live);
    if (!live || !sbi_live_take_over(matrix, live, sbi_live_capacity(matrix->row_count, slack),
                                     sbi_live_pool_capacity(matrix->block_count, slack))) {
        sbi_free(&matrix->allocator, live);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a matrix of %d rows that may change", matrix->row_count);
    }
    for (int i = 0; i < matrix->row_count; i++)
        live->in_use[i] = !in_use || in_use[i];
    for (int c = 0; c < cell_count; c++, cells += nodes_per_cell)
        for (int a = 0; a < nodes_per_cell && cells[0] >= 0; a++)
            for (int b = a + 1; b < nodes_per_cell; b++)
                sbi_live_count(matrix, cells[a], cells[b]);
    for (int k = 0; others && k < others->made_count; k++)
        sbi_live_count(matrix, others->made[2 * (size_t)k], others->made[2 * (size_t)k + 1]);
    for (int i = 0; i < matrix->row_count; i++)
        for (int q = matrix->row_start[i]; q < matrix->row_end[i]; q++)
            live->uses[q] += matrix->columns[q] != i && live->uses[q] == 0; /* needed for ever */
    sbi_matrix_set_free_rows(matrix);
    return SB_OK;
}

/* ---- checks ------------------------------------------------------------------------------------------------ */

static sb_result sbi_live_check_row(const sb_matrix *matrix, int i, sb_error *error)
{
    const sbi_matrix_live *live = matrix->live;
    int start = matrix->row_start[i], end = matrix->row_end[i];
    if (start < 0 || end <= start || end - start > live->room[i] || start > matrix->block_count - live->room[i])
        return sbi_fail_node(error, SB_ERROR_STATE, i, "row %d has %d blocks from %d on in %d places", i, end - start,
                             start, live->room[i]);
    if (!live->in_use[i] && (end - start != 1 || matrix->fixed[i] != SB_XYZ))
        return sbi_fail_node(error, SB_ERROR_STATE, i, "row %d is not in use, but coupled or free to move", i);
    if (matrix->diagonal[i] < start || matrix->diagonal[i] >= end || matrix->columns[matrix->diagonal[i]] != i)
        return sbi_fail_node(error, SB_ERROR_STATE, i, "row %d: the diagonal block is not where it should be", i);
    for (int q = start; q < end; q++) {
        int j = matrix->columns[q], twin = matrix->transpose[q];
        if (j < 0 || j >= matrix->row_count || (q > start && j <= matrix->columns[q - 1]))
            return sbi_fail_node(error, SB_ERROR_STATE, i, "row %d: column %d is out of order", i, j);
        if (twin != sb_matrix_find(matrix, j, i) || live->uses[q] != live->uses[twin])
            return sbi_fail_node(error, SB_ERROR_STATE, i, "row %d: column %d has another transpose or count", i, j);
        if ((j == i) != (live->uses[q] == 0))
            return sbi_fail_node(error, SB_ERROR_STATE, i, "row %d: column %d is counted %d times", i, j,
                                 live->uses[q]);
        if (live->part_of[j] != live->part_of[i])
            return sbi_fail_node(error, SB_ERROR_STATE, i, "row %d: column %d is in another part", i, j);
    }
    return SB_OK;
}

SBI_API sb_result sbi_matrix_check_live(const sb_matrix *matrix, sb_error *error)
{
    const sbi_matrix_live *live = matrix->live;
    int blocks = 0, alone = 0;
    if (!live)
        return SB_OK;
    if (matrix->row_count > live->row_capacity || matrix->block_count > live->block_capacity)
        return sbi_fail(error, SB_ERROR_STATE, "the matrix has more rows or blocks than room");
    for (int i = 0; i < matrix->row_count; i++) {
        sb_result result = sbi_live_check_row(matrix, i, error);
        blocks += matrix->row_end[i] - matrix->row_start[i];
        alone += sbi_live_is_alone(matrix, i);
        if (result != SB_OK)
            return result;
        if (live->marks[i])
            return sbi_fail_node(error, SB_ERROR_STATE, i, "row %d is marked", i);
    }
    if (blocks != live->used_blocks || alone != live->alone_count)
        return sbi_fail(error, SB_ERROR_STATE, "%d blocks in rows and %d rows alone, not %d and %d", blocks, alone,
                        live->used_blocks, live->alone_count);
    for (int size = 0; size < SBI_LIVE_PIECE_SIZES; size++)
        for (int at = live->free_pieces[size]; at >= 0; at = live->uses[at])
            for (int q = at; q < at + (size + 1) * SBI_LIVE_PIECE; q++)
                if (q >= matrix->block_count || matrix->columns[q] != 0 || matrix->transpose[q] != q)
                    return sbi_fail(error, SB_ERROR_STATE, "place %d of a free piece is in use", q);
    sbi_matrix_list_parts(matrix);
    for (int c = 0; c < matrix->part_count; c++)
        for (int k = matrix->part_start[c]; k < matrix->part_start[c + 1]; k++)
            if (live->part_of[matrix->part_rows[k]] != c)
                return sbi_fail(error, SB_ERROR_STATE, "row %d is listed in part %d", matrix->part_rows[k], c);
    for (int c = 0; c < matrix->part_count; c++)
        if (c != live->alone_part && live->part_first[c] != matrix->part_rows[matrix->part_start[c]])
            return sbi_fail(error, SB_ERROR_STATE, "part %d does not begin with row %d", c, live->part_first[c]);
    return SB_OK;
}
