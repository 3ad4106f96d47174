/* assembly_layout: arrays, chunks and their colours. */
#include "assembly_batch.h"
#include "assembly_live.h"

#include <string.h>

static int sbi_assembly_chunk_size(int cell_count)
{
    int size = cell_count / 64; /* enough chunks for many threads, each long enough to be worth a task */
    size = size < 16 ? 16 : size > 256 ? 256 : size;
    return (size + SB_POLAR_LANES - 1) / SB_POLAR_LANES * SB_POLAR_LANES;
}

SBI_API void sbi_assembly_layout(sbi_assembly *assembly, const sb_domain *domain, int block_count, int material_count,
                                 sbi_arena *arena)
{
    size_t cells = (size_t)sbi_assembly_cell_room(domain), n = (size_t)domain->nodes_per_cell;
    size_t chunks;
    assembly->domain = domain;
    if (assembly->chunk_size == 0) /* the size of a mesh that changes stays what it was first */
        assembly->chunk_size = sbi_assembly_chunk_size(domain->cell_count);
    assembly->chunk_count = (domain->cell_count - 1) / assembly->chunk_size + 1;
    chunks = (cells - 1) / (size_t)assembly->chunk_size + 1;
    assembly->rotations = (sb_quat *)sbi_arena_take(arena, cells, (size_t)domain->points_per_cell * sizeof(sb_quat));
    assembly->saved_rotations =
        (sb_quat *)sbi_arena_take(arena, cells, (size_t)domain->points_per_cell * sizeof(sb_quat));
    assembly->shares = (sb_material *)sbi_arena_take(arena, (size_t)material_count, 2 * sizeof(sb_material));
    assembly->relaxing = (sb_material *)sbi_arena_take(arena, (size_t)material_count, 2 * sizeof(sb_material));
    assembly->scatter = (int *)sbi_arena_take(arena, cells, n * (n + 1) / 2 * sizeof(int));
    assembly->colour_start = (int *)sbi_arena_take(arena, chunks + 1, sizeof(int));
    assembly->colour_chunks = (int *)sbi_arena_take(arena, chunks, sizeof(int));
    assembly->chunk_energy = (sb_real *)sbi_arena_take(arena, chunks, sizeof(sb_real));
    assembly->chunk_bad_cell = (int *)sbi_arena_take(arena, chunks, sizeof(int));
    if (sbi_batch_fits(domain))
        sbi_batch_layout(assembly, domain, block_count, arena);
}

/* Nodes of a chunk, of which some may be listed more than once. */
static void sbi_assembly_chunk_nodes(const sbi_assembly *assembly, int chunk, const int **first, const int **end)
{
    const sb_domain *domain = assembly->domain;
    size_t n = (size_t)domain->nodes_per_cell;
    if (assembly->live) {
        *first = assembly->live->chunk_nodes + 4 * (size_t)chunk * (size_t)assembly->chunk_size;
        *end = *first + assembly->live->chunk_node_count[chunk];
        return;
    }
    *first = domain->cells + (size_t)(chunk * assembly->chunk_size) * n;
    *end = domain->cells + (size_t)sbi_assembly_chunk_end(assembly, chunk) * n;
}

/* Colour of a chunk: the first that none of its nodes has; nodes remember theirs as bits. Beyond 63 colours (one
 * node shared by very many cells) each chunk gets a colour of its own. */
static int sbi_assembly_colour_chunk(const sbi_assembly *assembly, int chunk, uint64_t *node_colours, int *next)
{
    const int *first, *end;
    uint64_t taken = 0;
    int colour = 0;
    sbi_assembly_chunk_nodes(assembly, chunk, &first, &end);
    for (const int *node = first; node < end; node++)
        taken |= node_colours[*node];
    while (colour < 63 && (taken >> colour & 1))
        colour++;
    if (colour == 63) {
        *next = *next < 63 ? 63 : *next;
        return (*next)++;
    }
    for (const int *node = first; node < end; node++)
        node_colours[*node] |= (uint64_t)1 << colour;
    if (colour + 1 > *next)
        *next = colour + 1;
    return colour;
}

SBI_API void sbi_assembly_colour(sbi_assembly *assembly, uint64_t *node_colours)
{
    int *colour_of = assembly->chunk_bad_cell; /* free until the first loop runs */
    int position = 0;
    assembly->colour_count = 0;
    memset(node_colours, 0, (size_t)assembly->domain->node_count * sizeof *node_colours);
    for (int c = 0; c < assembly->chunk_count; c++)
        colour_of[c] = sbi_assembly_colour_chunk(assembly, c, node_colours, &assembly->colour_count);
    for (int colour = 0; colour < assembly->colour_count; colour++) {
        assembly->colour_start[colour] = position;
        for (int c = 0; c < assembly->chunk_count; c++)
            if (colour_of[c] == colour)
                assembly->colour_chunks[position++] = c;
    }
    assembly->colour_start[assembly->colour_count] = position;
}
