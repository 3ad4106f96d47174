/* assembly_live: rings of cells, and maps of the rows that a change touched. */
#include "assembly_live.h"

#include <limits.h>
#include <string.h>

/* ---- memory -------------------------------------------------------------------------------------------- */

static void sbi_assembly_live_layout(sbi_assembly_live *live, size_t chunk_size, sbi_arena *arena)
{
    size_t nodes = (size_t)live->node_capacity, cells = (size_t)live->cell_capacity;
    live->node_colours = (uint64_t *)sbi_arena_take(arena, nodes, sizeof(uint64_t));
    live->units = (sb_real *)sbi_arena_take(arena, cells / SBI_LIVE_UNIT + 1, sizeof(sb_real));
    live->chunk_nodes = (int *)sbi_arena_take(arena, cells, 4 * sizeof(int));
    live->chunk_node_count = (int *)sbi_arena_take(arena, cells / chunk_size + 1, sizeof(int));
    live->corner_first = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    live->corner_next = (int *)sbi_arena_take(arena, cells, 4 * sizeof(int));
    live->pair_next = (int *)sbi_arena_take(arena, cells, 6 * sizeof(int));
    live->place = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    live->unmapped = (unsigned char *)sbi_arena_take(arena, nodes, 1);
    live->marks = (unsigned char *)sbi_arena_take(arena, nodes, 1);
    live->kept = (unsigned char *)sbi_arena_take(arena, cells, 1);
}

/* Zeroed arrays of the capacities in `live`; 0: no memory. */
static int sbi_assembly_live_take(sbi_assembly_live *live, int chunk_size)
{
    sbi_arena arena = {NULL, 0, 0};
    sbi_assembly_live_layout(live, (size_t)chunk_size, &arena);
    live->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&live->allocator, arena.used, 1);
    if (!live->memory)
        return 0;
    arena.base = (unsigned char *)live->memory;
    arena.used = 0;
    sbi_assembly_live_layout(live, (size_t)chunk_size, &arena);
    return 1;
}

SBI_API void sbi_assembly_free_live(sbi_assembly *assembly)
{
    sbi_assembly_live *live = assembly->live;
    sb_allocator allocator;
    if (!live)
        return;
    allocator = live->allocator;
    sbi_free(&allocator, live->memory);
    sbi_free(&allocator, live->arrays);
    sbi_free(&allocator, live->inherited);
    sbi_free(&allocator, live->memories);
    sbi_free(&allocator, live);
    assembly->live = NULL;
}

/* ---- rings ------------------------------------------------------------------------------------------------ */

/* Puts a corner into the ring of its node. */
static void sbi_ring_add(sbi_assembly_live *live, int node, int corner)
{
    int *at = live->corner_first + node;
    while (*at >= 0 && *at < corner)
        at = live->corner_next + *at;
    live->corner_next[corner] = *at;
    *at = corner;
}

static void sbi_ring_remove(sbi_assembly_live *live, int node, int corner)
{
    int *at = live->corner_first + node;
    while (*at != corner)
        at = live->corner_next + *at;
    *at = live->corner_next[corner];
}

/* Place in a ring's list of what comes at or after a pair: its block's, or the next of the pair before. */
static int *sbi_ring_of_pairs(const sbi_assembly_live *live, const sb_matrix *matrix, int block, int pair)
{
    int *at = matrix->live->heads + block;
    while (*at >= 0 && *at < pair)
        at = live->pair_next + sbi_live_pair_index(*at);
    return at;
}

/* Blocks found last, by their nodes: of the couplings that a change is about, each has a handful of its cells. */
enum { SBI_FOUND_BLOCKS = 256 };
typedef struct sbi_found_block {
    int low, high, block;
} sbi_found_block;

/* Where in the matrix the block of two nodes above the diagonal is, or -1. */
static int sbi_live_find_block(const sb_matrix *matrix, int i, int j, sbi_found_block *found)
{
    int low = sbi_min_int(i, j), high = sbi_max_int(i, j);
    sbi_found_block *known = found + ((unsigned)low * 31u + (unsigned)high) % SBI_FOUND_BLOCKS;
    if (known->low != low || known->high != high) {
        known->low = low;
        known->high = high;
        known->block = sb_matrix_find(matrix, low, high);
    }
    return known->block;
}

/* The pair of two corners of a cell. */
static int sbi_live_pair_of(int e, const int *nodes, int a, int b)
{
    int flip = nodes[a] > nodes[b];
    return sbi_batch_pair(e, flip ? b : a, flip ? a : b, SBI_PAIR_NODE_BITS);
}

/* Takes the pairs of a cell out of their rings; kept: corners, as bits, that keep their node. */
static void sbi_live_remove_pairs(const sbi_assembly_live *live, const sb_matrix *matrix, int e, const int *nodes,
                                  int kept, sbi_found_block *found)
{
    for (int a = 0; a < 4; a++)
        for (int b = a + 1; b < 4; b++) {
            int block, pair, *at;
            if ((kept >> a & kept >> b & 1) != 0)
                continue;
            pair = sbi_live_pair_of(e, nodes, a, b);
            block = sbi_live_find_block(matrix, nodes[a], nodes[b], found);
            at = block >= 0 ? sbi_ring_of_pairs(live, matrix, block, pair) : NULL;
            if (at && *at == pair) /* else the coupling went, and another came */
                *at = live->pair_next[sbi_live_pair_index(pair)];
        }
}

/* Puts those in that are not there; kept: corners whose pairs are. */
static void sbi_live_add_pairs(const sbi_assembly_live *live, const sb_matrix *matrix, int e, const int *nodes,
                               int kept, sbi_found_block *found)
{
    for (int a = 0; a < 4; a++)
        for (int b = a + 1; b < 4; b++) {
            int pair, *at;
            if ((kept >> a & kept >> b & 1) != 0)
                continue;
            pair = sbi_live_pair_of(e, nodes, a, b);
            at = sbi_ring_of_pairs(live, matrix, sbi_live_find_block(matrix, nodes[a], nodes[b], found), pair);
            if (*at == pair)
                continue;
            live->pair_next[sbi_live_pair_index(pair)] = *at;
            *at = pair;
        }
}

/* None yet. */
static void sbi_live_forget_blocks(sbi_found_block *found)
{
    for (int k = 0; k < SBI_FOUND_BLOCKS; k++)
        found[k].low = -1;
}

/* ---- maps ------------------------------------------------------------------------------------------------- */

/* Number of the pair (a, b), a <= b, of a tet's nodes in scatter maps. */
static int sbi_live_scatter_place(int a, int b) { return a * (9 - a) / 2 + b - a; }

/* Where the blocks of row i are, for its cells. */
static void sbi_assembly_map_row(const sbi_assembly *assembly, const sb_matrix *matrix, int i)
{
    sbi_assembly_live *live = assembly->live;
    for (int q = matrix->row_start[i]; q < matrix->row_end[i]; q++)
        live->place[matrix->columns[q]] = q;
    for (int corner = live->corner_first[i]; corner >= 0; corner = live->corner_next[corner]) {
        int e = corner / 4, a = corner % 4;
        const int *cell = assembly->domain->cells + 4 * (size_t)e;
        for (int b = a; b < 4; b++)
            assembly->scatter[10 * (size_t)e + (size_t)sbi_live_scatter_place(a, b)] = live->place[cell[b]];
    }
    live->unmapped[i] = 0;
}

SBI_API void sbi_assembly_settle_maps(const sbi_assembly *assembly, const sb_matrix *matrix)
{
    sbi_assembly_live *live = assembly->live;
    if (!live || !live->maps_are_old)
        return;
    for (int i = 0; i < matrix->row_count; i++)
        if (live->unmapped[i])
            sbi_assembly_map_row(assembly, matrix, i);
    live->maps_are_old = 0;
}

/* All pairs and maps anew. */
SBI_API void sbi_assembly_map_rows(sbi_assembly *assembly, const sb_matrix *matrix)
{
    const sb_domain *domain = assembly->domain;
    sbi_assembly_live *live = assembly->live;
    sbi_found_block found[SBI_FOUND_BLOCKS];
    sbi_live_forget_blocks(found);
    for (int q = 0; q < matrix->block_count; q++)
        matrix->live->heads[q] = -1;
    for (int e = domain->cell_count; e-- > 0;) /* the last first, so that none has to be passed */
        if (!sbi_domain_is_free(domain, e))
            sbi_live_add_pairs(live, matrix, e, domain->cells + 4 * (size_t)e, 0, found);
    memset(live->unmapped, 1, (size_t)matrix->row_count);
    live->maps_are_old = 1;
}

/* ---- chunks ------------------------------------------------------------------------------------------------ */

/* Groups of cells whose energy units are summed at once. */
static int sbi_live_unit_count(const sbi_assembly *assembly)
{
    return (assembly->domain->cell_count - 1) / SBI_LIVE_UNIT + 1;
}

static sb_real sbi_assembly_weigh_group(const sbi_assembly *assembly, int group)
{
    int first = group * SBI_LIVE_UNIT, end = sbi_min_int(first + SBI_LIVE_UNIT, assembly->domain->cell_count);
    sb_real sum = 0;
    for (int e = first; e < end; e++) {
        const sb_material *material = assembly->materials + assembly->cell_material[e];
        sum += assembly->domain->weights[e] * (material->lambda + 2 * material->mu);
    }
    return sum;
}

/* The sum of all, with those anew that are marked. */
static void sbi_assembly_sum_units(sbi_assembly *assembly)
{
    sb_real *units = assembly->live->units;
    int count = sbi_live_unit_count(assembly);
    assembly->energy_unit = 0;
    for (int group = 0; group < count; group++) {
        if (units[group] < 0)
            units[group] = sbi_assembly_weigh_group(assembly, group);
        assembly->energy_unit += units[group];
    }
}

SBI_API void sbi_assembly_weigh_all(sbi_assembly *assembly)
{
    int count = sbi_live_unit_count(assembly);
    for (int group = 0; group < count; group++)
        assembly->live->units[group] = -1;
    sbi_assembly_sum_units(assembly);
}

/* Lists the nodes of a chunk's cells. */
static void sbi_assembly_list_nodes(sbi_assembly *assembly, int chunk)
{
    const int *cells = assembly->domain->cells;
    sbi_assembly_live *live = assembly->live;
    int first = 4 * chunk * assembly->chunk_size, end = 4 * sbi_assembly_chunk_end(assembly, chunk), count = 0;
    for (int k = first; k < end; k++)
        if (!sbi_domain_is_free(assembly->domain, k / 4) && !live->marks[cells[k]]) {
            live->marks[cells[k]] = 1;
            live->chunk_nodes[first + count++] = cells[k];
        }
    for (int k = first; k < first + count; k++)
        live->marks[live->chunk_nodes[k]] = 0;
    live->chunk_node_count[chunk] = count;
}

/* ---- making one ------------------------------------------------------------------------------------------- */

static void sbi_assembly_make_rings(sbi_assembly *assembly, const sb_matrix *matrix)
{
    const sb_domain *domain = assembly->domain;
    sbi_assembly_live *live = assembly->live;
    for (int i = 0; i < live->node_capacity; i++)
        live->corner_first[i] = -1;
    for (int corner = 4 * domain->cell_count; corner-- > 0;) {
        if (!sbi_domain_is_free(domain, corner / 4))
            sbi_ring_add(live, domain->cells[corner], corner);
    }
    sbi_assembly_map_rows(assembly, matrix);
    for (int chunk = 0; chunk < assembly->chunk_count; chunk++)
        sbi_assembly_list_nodes(assembly, chunk);
    sbi_assembly_colour(assembly, live->node_colours);
}

SBI_API sb_result sbi_assembly_make_live(sbi_assembly *assembly, const sb_matrix *matrix, const sb_allocator *allocator,
                                         sb_error *error)
{
    sbi_assembly_live *live = (sbi_assembly_live *)sbi_alloc_zeroed(allocator, 1, sizeof *live);
    if (live) {
        if (allocator)
            live->allocator = *allocator;
        live->node_capacity = matrix->live->row_capacity;
        live->cell_capacity = assembly->domain->cell_capacity;
        live->cell_end = assembly->domain->cell_count;
    }
    if (!live || !sbi_assembly_live_take(live, assembly->chunk_size)) {
        sbi_free(allocator, live);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the rings of %d cells", assembly->domain->cell_count);
    }
    assembly->live = live;
    sbi_assembly_make_rings(assembly, matrix);
    return SB_OK;
}

/* ---- growing ---------------------------------------------------------------------------------------------- */

/* Copies what cells have from arrays that were outgrown. */
static void sbi_assembly_copy_arrays(const sbi_assembly *from, sbi_assembly *to)
{
    size_t cells = (size_t)from->domain->cell_count, lane = SB_POLAR_LANES * sizeof(sb_real);
    size_t batches = (cells + SB_POLAR_LANES - 1) / SB_POLAR_LANES;
    size_t materials = (size_t)from->material_count * 2 * sizeof(sb_material);
    memcpy(to->rotations, from->rotations, cells * sizeof(sb_quat));
    memcpy(to->saved_rotations, from->saved_rotations, cells * sizeof(sb_quat));
    memcpy(to->shares, from->shares, materials);
    memcpy(to->relaxing, from->relaxing, materials);
    memcpy(to->scatter, from->scatter, cells * 10 * sizeof(int));
    memcpy(to->batch_gradients, from->batch_gradients, batches * 9 * lane);
    memcpy(to->batch_moduli, from->batch_moduli, batches * 3 * lane);
    memcpy(to->batch_quats, from->batch_quats, batches * 4 * lane);
    memcpy(to->saved_batch_quats, from->saved_batch_quats, batches * 4 * lane);
    memcpy(to->ratios, from->ratios, cells * sizeof(sb_real));
}

/* The assembly's own arrays for the cells that the domain has room for; 0: no memory. */
static int sbi_assembly_grow_arrays(sbi_assembly *assembly, const sb_matrix *matrix)
{
    sbi_assembly grown = *assembly;
    sbi_arena arena = {NULL, 0, 0};
    int count = assembly->chunk_count;
    void *memory;
    sbi_assembly_layout(&grown, assembly->domain, matrix->block_count, assembly->material_count, &arena);
    memory = arena.overflow ? NULL : sbi_alloc_zeroed(&assembly->live->allocator, arena.used, 1);
    if (!memory)
        return 0;
    arena.base = (unsigned char *)memory;
    arena.used = 0;
    sbi_assembly_layout(&grown, assembly->domain, matrix->block_count, assembly->material_count, &arena);
    sbi_assembly_copy_arrays(assembly, &grown);
    memcpy(grown.colour_start, assembly->colour_start, (size_t)(assembly->colour_count + 1) * sizeof(int));
    memcpy(grown.colour_chunks, assembly->colour_chunks, (size_t)count * sizeof(int));
    memcpy(grown.chunk_energy, assembly->chunk_energy, (size_t)count * sizeof(sb_real));
    memcpy(grown.chunk_bad_cell, assembly->chunk_bad_cell, (size_t)count * sizeof(int));
    sbi_free(&assembly->live->allocator, assembly->live->arrays);
    assembly->live->arrays = memory;
    *assembly = grown;
    return 1;
}

/* Viscous memory for as many cells; 0: no memory. */
static int sbi_assembly_grow_memory(sbi_assembly *assembly)
{
    const sb_allocator *allocator = &assembly->live->allocator;
    size_t stride = sbi_memory_stride(assembly), cells = (size_t)assembly->domain->cell_capacity;
    size_t used = (size_t)assembly->domain->cell_count;
    sb_real *history, *prestress;
    if (!assembly->history)
        return 1;
    history = (sb_real *)sbi_alloc_zeroed(allocator, cells, 2 * stride * sizeof(sb_real));
    prestress = (sb_real *)sbi_alloc_zeroed(allocator, cells, 6 * sizeof(sb_real));
    if (!history || !prestress) {
        sbi_free(allocator, history);
        sbi_free(allocator, prestress);
        return 0;
    }
    memcpy(history, assembly->history, used * stride * sizeof(sb_real));
    memcpy(prestress, assembly->prestress, used * 6 * sizeof(sb_real));
    sbi_free(allocator, assembly->history);
    sbi_free(allocator, assembly->prestress);
    assembly->history = history;
    assembly->prestress = prestress;
    return 1;
}

/* Rings for the capacities of domain and matrix; 0: no memory. */
static int sbi_assembly_grow_rings(const sbi_assembly *assembly, const sb_matrix *matrix)
{
    sbi_assembly_live *live = assembly->live, grown = *live;
    size_t cells = (size_t)assembly->domain->cell_count;
    grown.node_capacity = sbi_max_int(live->node_capacity, matrix->live->row_capacity);
    grown.cell_capacity = assembly->domain->cell_capacity;
    if (!sbi_assembly_live_take(&grown, assembly->chunk_size))
        return 0;
    memcpy(grown.corner_first, live->corner_first, (size_t)live->node_capacity * sizeof(int));
    for (int i = live->node_capacity; i < grown.node_capacity; i++)
        grown.corner_first[i] = -1;
    memcpy(grown.corner_next, live->corner_next, cells * 4 * sizeof(int));
    memcpy(grown.unmapped, live->unmapped, (size_t)live->node_capacity);
    memcpy(grown.pair_next, live->pair_next, cells * 6 * sizeof(int));
    memcpy(grown.units, live->units, (size_t)sbi_live_unit_count(assembly) * sizeof(sb_real));
    memcpy(grown.chunk_nodes, live->chunk_nodes, cells * 4 * sizeof(int));
    memcpy(grown.chunk_node_count, live->chunk_node_count, (size_t)assembly->chunk_count * sizeof(int));
    sbi_free(&live->allocator, live->memory);
    *live = grown;
    return 1;
}

SBI_API sb_result sbi_assembly_reserve_remap(const sbi_assembly *assembly, const sb_matrix *matrix, sb_error *error)
{
    int fits = !assembly->live || assembly->live->node_capacity >= matrix->live->row_capacity;
    return fits || sbi_assembly_grow_rings(assembly, matrix)
               ? SB_OK
               : sbi_fail(error, SB_ERROR_MEMORY, "no memory for the rings of %d blocks", matrix->block_count);
}

/* Places to keep what parents have; 0: no memory. */
static int sbi_assembly_reserve_inherited(sbi_assembly *assembly, int count)
{
    sbi_assembly_live *live = assembly->live;
    size_t stride = assembly->history ? sbi_memory_stride(assembly) : 0;
    sb_quat *inherited;
    sb_real *memories;
    if (count <= live->inherited_capacity && stride <= live->stride)
        return 1;
    count = sbi_max_int(count > INT_MAX / 2 ? count : 2 * count, live->inherited_capacity);
    inherited = (sb_quat *)sbi_alloc(&live->allocator, (size_t)count, 2 * sizeof(sb_quat));
    memories = (sb_real *)sbi_alloc(&live->allocator, (size_t)count, (stride + 1) * sizeof(sb_real));
    if (!inherited || !memories) {
        sbi_free(&live->allocator, inherited);
        sbi_free(&live->allocator, memories);
        return 0;
    }
    sbi_free(&live->allocator, live->inherited);
    sbi_free(&live->allocator, live->memories);
    live->inherited = inherited;
    live->memories = memories;
    live->inherited_capacity = count;
    live->stride = stride;
    return 1;
}

SBI_API sb_result sbi_assembly_reserve_parents(sbi_assembly *assembly, int cells, sb_error *error)
{
    return sbi_assembly_reserve_inherited(assembly, cells)
               ? SB_OK
               : sbi_fail(error, SB_ERROR_MEMORY, "no memory for changes of %d cells", cells);
}

SBI_API sb_result sbi_assembly_reserve(sbi_assembly *assembly, const sb_matrix *matrix, const sbi_mesh_change *change,
                                       sb_error *error)
{
    sbi_assembly_live *live = assembly->live;
    int more_cells = live->cell_capacity < assembly->domain->cell_capacity, made = 1;
    if (more_cells)
        made = sbi_assembly_grow_memory(assembly) && sbi_assembly_grow_arrays(assembly, matrix);
    if (made && (more_cells || live->node_capacity < matrix->live->row_capacity))
        made = sbi_assembly_grow_rings(assembly, matrix);
    if (made)
        made = sbi_assembly_reserve_inherited(assembly, change->made_cell_count);
    return made ? SB_OK : sbi_fail(error, SB_ERROR_MEMORY, "no memory for an assembly of %d cells", change->cell_end);
}

/* ---- following -------------------------------------------------------------------------------------------- */

/* Keeps rotations and memories of the parents before any slot is used again. */
static void sbi_assembly_read_parents(sbi_assembly *assembly, const sbi_mesh_change *change)
{
    sbi_assembly_live *live = assembly->live;
    size_t stride = assembly->history ? sbi_memory_stride(assembly) : 0;
    for (int k = 0; k < change->made_cell_count; k++) {
        int parent = change->made_parents ? change->made_parents[k] : -1;
        live->inherited[2 * (size_t)k] = parent < 0 ? sb_quat_identity() : assembly->rotations[parent];
        live->inherited[2 * (size_t)k + 1] = parent < 0 ? sb_quat_identity() : sbi_batch_get_quat(assembly, parent);
        if (stride && parent >= 0)
            memcpy(live->memories + (size_t)k * stride, assembly->history + (size_t)parent * stride,
                   stride * sizeof(sb_real));
        else if (stride)
            memset(live->memories + (size_t)k * stride, 0, stride * sizeof(sb_real));
    }
}

/* A cell's rotations (of the loops that take any material, and of the batches) and its memory; NULL: nothing. */
static void sbi_assembly_set_history(sbi_assembly *assembly, int e, const sb_quat rotations[2], const sb_real *memory)
{
    size_t stride = assembly->history ? sbi_memory_stride(assembly) : 0;
    assembly->rotations[e] = assembly->saved_rotations[e] = rotations[0];
    sbi_batch_set_quat(assembly, e, rotations[1]);
    if (!stride)
        return;
    if (memory)
        memcpy(assembly->history + (size_t)e * stride, memory, stride * sizeof(sb_real));
    else
        memset(assembly->history + (size_t)e * stride, 0, stride * sizeof(sb_real));
    memset(assembly->prestress + 6 * (size_t)e, 0, 6 * sizeof(sb_real));
}

static void sbi_assembly_blank(sbi_assembly *assembly, int e)
{
    sb_quat rotations[2];
    rotations[0] = rotations[1] = sb_quat_identity();
    sbi_assembly_set_history(assembly, e, rotations, NULL);
    sbi_batch_set_cell(assembly, e);
}

static void sbi_assembly_follow_cells(sbi_assembly *assembly, const sbi_mesh_change *change, int old_end)
{
    const sb_domain *domain = assembly->domain;
    const sbi_assembly_live *live = assembly->live;
    size_t stride = assembly->history ? sbi_memory_stride(assembly) : 0;
    for (int e = old_end; e < domain->cell_count; e++)
        sbi_assembly_blank(assembly, e);
    for (int k = 0; k < change->removed_cell_count; k++) /* others are made below */
        if (change->removed_cells[k] < domain->cell_count && sbi_domain_is_free(domain, change->removed_cells[k]))
            sbi_assembly_blank(assembly, change->removed_cells[k]);
    for (int k = 0; k < change->made_cell_count; k++) {
        int e = change->made_cells[k];
        sbi_assembly_set_history(assembly, e, live->inherited + 2 * (size_t)k, live->memories + (size_t)k * stride);
        sbi_batch_set_cell(assembly, e);
    }
    for (int k = 0; k < change->reshaped_cell_count; k++)
        sbi_batch_set_cell(assembly, change->reshaped_cells[k]);
}

/* Takes a cell's corners out of the rings of their nodes, but where one made in its slot has the same node. */
static void sbi_assembly_leave_rings(sbi_assembly *assembly, int e, const int *nodes)
{
    const sb_domain *domain = assembly->domain;
    const int *now = e < domain->cell_count && !sbi_domain_is_free(domain, e) ? domain->cells + 4 * (size_t)e : NULL;
    for (int a = 0; a < 4; a++) {
        if (now && now[a] == nodes[a])
            assembly->live->kept[e] |= (unsigned char)(1 << a);
        else
            sbi_ring_remove(assembly->live, nodes[a], 4 * e + a);
        assembly->live->unmapped[nodes[a]] = 1;
    }
}

static void sbi_assembly_join_rings(sbi_assembly *assembly, int e, const int *nodes)
{
    for (int a = 0; a < 4; a++) {
        if (!(assembly->live->kept[e] >> a & 1))
            sbi_ring_add(assembly->live, nodes[a], 4 * e + a);
        assembly->live->unmapped[nodes[a]] = 1;
    }
    assembly->live->kept[e] = 0;
}

/* Rings, and which rows are to be mapped again. */
static void sbi_assembly_follow_rings(sbi_assembly *assembly, const sb_matrix *matrix, const sbi_mesh_change *change)
{
    sbi_assembly_live *live = assembly->live;
    sbi_found_block found[SBI_FOUND_BLOCKS];
    sbi_live_forget_blocks(found);
    for (int k = 0; k < change->removed_cell_count; k++) {
        int e = change->removed_cells[k];
        const int *nodes = change->removed_cell_nodes + 4 * (size_t)k;
        sbi_assembly_leave_rings(assembly, e, nodes);
        sbi_live_remove_pairs(live, matrix, e, nodes, live->kept[e], found);
    }
    for (int k = 0; k < change->made_cell_count; k++) {
        int e = change->made_cells[k], kept = live->kept[e];
        const int *nodes = change->made_cell_nodes + 4 * (size_t)k;
        sbi_assembly_join_rings(assembly, e, nodes);
        sbi_live_add_pairs(live, matrix, e, nodes, kept, found);
    }
    for (int k = 0; k < matrix->live->touched_count; k++)
        live->unmapped[matrix->live->touched[k]] = 1;
    live->maps_are_old = 1;
}

/* What is summed or listed of a cell's neighbours in memory is old. */
static void sbi_assembly_mark_cell(sbi_assembly *assembly, int e)
{
    if (e >= assembly->domain->cell_count)
        return;
    assembly->live->units[e / SBI_LIVE_UNIT] = -1;
    assembly->live->chunk_node_count[e / assembly->chunk_size] = -1;
}

/* Energy units; the nodes of chunks with changed cells, and all colours, are left to the next loop. */
static void sbi_assembly_follow_chunks(sbi_assembly *assembly, const sbi_mesh_change *change, int old_end)
{
    for (int e = sbi_min_int(old_end, assembly->domain->cell_count) - 1; e < assembly->domain->cell_count; e++)
        sbi_assembly_mark_cell(assembly, e);
    for (int k = 0; k < change->removed_cell_count; k++)
        sbi_assembly_mark_cell(assembly, change->removed_cells[k]);
    for (int k = 0; k < change->made_cell_count; k++)
        sbi_assembly_mark_cell(assembly, change->made_cells[k]);
    for (int k = 0; k < change->reshaped_cell_count; k++)
        sbi_assembly_mark_cell(assembly, change->reshaped_cells[k]);
    sbi_assembly_sum_units(assembly);
    assembly->live->colours_are_old = 1;
}

SBI_API void sbi_assembly_settle_colours(sbi_assembly *assembly)
{
    sbi_assembly_live *live = assembly->live;
    if (!live || !live->colours_are_old)
        return;
    for (int chunk = 0; chunk < assembly->chunk_count; chunk++)
        if (live->chunk_node_count[chunk] < 0)
            sbi_assembly_list_nodes(assembly, chunk);
    sbi_assembly_colour(assembly, live->node_colours);
    live->colours_are_old = 0;
}

SBI_API void sbi_assembly_follow(sbi_assembly *assembly, const sb_matrix *matrix, const sbi_mesh_change *change)
{
    const sb_domain *domain = assembly->domain;
    int old_end = assembly->live->cell_end;
    sbi_assembly_read_parents(assembly, change);
    assembly->live->cell_end = domain->cell_count;
    assembly->chunk_count = (domain->cell_count - 1) / assembly->chunk_size + 1;
    sbi_assembly_follow_cells(assembly, change, old_end);
    sbi_assembly_follow_rings(assembly, matrix, change);
    sbi_assembly_follow_chunks(assembly, change, old_end);
    if (assembly->viscous)
        sbi_assembly_begin_step(assembly, 0);
}
