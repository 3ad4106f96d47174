/* assembly_live: an assembly of tet4 whose cells and matrix change. Floor 2, internal.
 *
 * The cells about a node are a ring of corners 4 e + a, and those that add to a block above the diagonal a ring of
 * pairs, both in ascending order of cells: sums form in one order whatever the history, that of a mesh whose lists are
 * made at once. A change sees to the rings of changed cells only. Scatter maps of the rows that it touched wait for the
 * first loop that reads them; where all cells are batched there may be none. Chunks and colours are those of the cells'
 * slots; the first loop after a change colours them anew by lists of their nodes, a few per cent of its time. */
#ifndef SB_ASSEMBLY_LIVE_H
#define SB_ASSEMBLY_LIVE_H

#include "assembly_batch.h"
#include "../solve/sparse_live.h"

enum { SBI_LIVE_UNIT = SB_POLAR_LANES };

typedef struct sbi_assembly_live {
    sb_allocator allocator;
    int node_capacity, cell_capacity;
    int cell_end;      /* slots before the change at hand */
    int *corner_first; /* [node_capacity] or -1 */
    int *corner_next;  /* [4 cell_capacity] or -1 */
    int *pair_next;    /* [6 cell_capacity] by cell and pair of nodes, or -1; the first of a block above the diagonal
                        * is the matrix's live->heads, an sbi_batch_pair */
    int *place;        /* [node_capacity] scratch */
    unsigned char *unmapped; /* [node_capacity] 1: the row's part of the scatter maps is old */
    int maps_are_old;        /* 1: some row's is */
    unsigned char *marks;    /* [node_capacity] zeros between calls */
    unsigned char
        *kept; /* [cell_capacity] zeros between calls; corners, as bits, that keep their node in the change at hand */
    uint64_t *node_colours; /* [node_capacity] scratch */
    int *chunk_nodes; /* [4 cell_capacity] the nodes of each chunk's cells, each once, from where its cells begin on */
    int *chunk_node_count; /* [chunks], -1: to be listed again */
    int colours_are_old;   /* 1: chunks are to be listed and coloured before the next loop */
    sb_real *units;        /* [cells / SBI_LIVE_UNIT] energy units of so many cells, < 0: to be summed again */
    sb_quat *inherited;    /* [inherited_capacity] rotations of parents */
    sb_real *memories;     /* [inherited_capacity][stride] what they remember of viscous stress */
    int inherited_capacity;
    size_t stride;
    void *memory; /* of the arrays above */
    void *arrays; /* of the assembly's, once they have outgrown the place they were made in */
} sbi_assembly_live;

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* Lets a prepared assembly of a live domain and a live matrix follow changes; SB_ERROR_MEMORY: nothing has changed. */
SBI_API sb_result sbi_assembly_make_live(sbi_assembly *assembly, const sb_matrix *matrix, const sb_allocator *allocator,
                                         sb_error *error);
/* Memory to follow a change that domain and matrix have room for already. */
SBI_API sb_result sbi_assembly_reserve(sbi_assembly *assembly, const sb_matrix *matrix, const sbi_mesh_change *change,
                                       sb_error *error);
/* Memory for changes that make so many cells. */
SBI_API sb_result sbi_assembly_reserve_parents(sbi_assembly *assembly, int cells, sb_error *error);
/* Follows, after domain and matrix and the array of the cells' materials have. A made cell has its parent's rotation
 * and viscous memory, without a parent those of rest. */
SBI_API void sbi_assembly_follow(sbi_assembly *assembly, const sb_matrix *matrix, const sbi_mesh_change *change);
/* Lists and colours chunks where a change has left that to be done. For all who run over chunks. */
SBI_API void sbi_assembly_settle_colours(sbi_assembly *assembly);
/* Maps rows where changes have left that to be done. For all who read scatter maps. */
SBI_API void sbi_assembly_settle_maps(const sbi_assembly *assembly, const sb_matrix *matrix);
/* The energy units of all chunks, and their sum. */
SBI_API void sbi_assembly_weigh_all(sbi_assembly *assembly);
/* Memory for another matrix of the same nodes, and its maps. */
SBI_API sb_result sbi_assembly_reserve_remap(const sbi_assembly *assembly, const sb_matrix *matrix, sb_error *error);
SBI_API void sbi_assembly_map_rows(sbi_assembly *assembly, const sb_matrix *matrix);
SBI_API void sbi_assembly_free_live(sbi_assembly *assembly);

/* Place of a pair in pair_next. */
SB_INLINE int sbi_live_pair_index(int pair)
{
    static const signed char number[16] = {0, 0, 1, 2, 0, 0, 3, 4, 1, 3, 0, 5, 2, 4, 5, 0};
    int e = pair >> 2 * SBI_PAIR_NODE_BITS, a = pair >> SBI_PAIR_NODE_BITS & 15, b = pair & 15;
    return 6 * e + number[4 * a + b];
}
/* The pair after this one in its block's ring, or -1. */
SB_INLINE int sbi_live_next_pair(const sbi_assembly_live *live, int pair)
{
    return live->pair_next[sbi_live_pair_index(pair)];
}
#endif

#endif /* SB_ASSEMBLY_LIVE_H */
