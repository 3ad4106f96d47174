/* sparse_live: a matrix whose pattern follows a mesh that changes. Floor 1, internal.
 *
 * Rows lie in one pool, each in a piece with room to spare. A row that outgrows its piece moves to a free piece of the
 * size it needs, or to the pool's end; pieces come in sizes of SBI_LIVE_PIECE places and wait in one list a size. When
 * the pool is full, or a quarter of the rows have moved, rows are pushed together in their order. Columns ascend in
 * every row whatever the history, so products, sums over rows and all that is made from them are functions of the
 * pattern alone; only positions in the pool are history. Places in no row hold blocks of column 0 that are their own
 * transposes. A change leaves the values of all blocks to chance: a matrix is filled anew after it.
 *
 * Each coupling counts the cells that have both its nodes, and the loads, mappings and constraints that need it
 * besides; it goes when the last of them does. A row that is not in use keeps its diagonal block, the identity, and is
 * fixed. */
#ifndef SB_SPARSE_LIVE_H
#define SB_SPARSE_LIVE_H

#include "../mesh/mesh_change.h"
#include "sparse.h"

enum { SBI_LIVE_PIECE = 4, SBI_LIVE_PIECE_SIZES = 64 };

/* Couplings besides those of cells that come and go, each named once as a pair of nodes; a pair that comes twice has to
 * go twice. Those of nodes that a change removes go by themselves: leave them out. Pairs of one node with itself count
 * for nothing. */
typedef struct sbi_matrix_couplings {
    int gone_count;
    const int *gone; /* [gone_count][2] */
    int made_count;
    const int *made; /* [made_count][2] */
} sbi_matrix_couplings;

/* A coupling that a change makes, in one direction. */
typedef struct sbi_live_key {
    int row, column;
    int uses;
    int pair;
} sbi_live_key;

/* Two nodes that a change is about: by how much the uses of their coupling change in all. */
typedef struct sbi_live_pair {
    int low, high;
    int uses;
    int next;      /* while the plan is made: the next one with the same low node, or -1 */
    int places[2]; /* of its blocks above and below the diagonal; of a coupling that there is the first */
} sbi_live_pair;

typedef struct sbi_matrix_live {
    int row_capacity, block_capacity;
    unsigned version; /* how many changes of the pattern, or of where its blocks are, there were, from 1 */
    int *room;        /* [row_capacity] places of the row's piece */
    int *uses;        /* [block_capacity] of each coupling; of the diagonal and of places in no row 0 */
    int *heads;  /* [block_capacity] for whoever lists what adds to a coupling: it goes with the coupling; -1 of new
                  * ones,  and of places in no row */
    int *places; /* [block_capacity] scratch */
    unsigned char *in_use;                 /* [row_capacity] */
    unsigned char *marks;                  /* [row_capacity] zeros between calls */
    int free_pieces[SBI_LIVE_PIECE_SIZES]; /* first place of the last one freed of each size, -1: none; `uses` of that
                                            * place has the next */
    /* what the last change did */
    int *touched; /* [row_capacity] rows with other columns or in other places than before */
    int touched_count;
    int repacked;    /* 1: all rows moved */
    int packed_end;  /* of the pool when rows were pushed together last, or the matrix was made */
    int moved_count; /* rows that have left what was there then */
    int used_blocks; /* blocks that are in rows */
    /* parts */
    int *part_of;    /* [row_capacity] */
    int *part_first; /* [parts] first row of each; not kept up of the part of rows alone */
    int alone_part,
        alone_count;   /* the part of the rows that have their diagonal block only, or -1, and how many there are */
    int first_is_lost; /* 1: the first row of a part went in the change at hand */
    int renumbered;    /* 1: the last change numbered the parts again: rows it did not touch may have another */
    int listed;        /* 1: part_start and part_rows are those of part_of */
    int *lost, *held, *seen; /* [row_capacity] scratch */
    /* the plan of the change reserved last */
    sbi_live_key *keys; /* new couplings, by row and column */
    int key_count, key_capacity;
    sbi_live_pair *pairs; /* couplings that there are and that are used more or less often */
    int pair_count, pair_capacity;
    int pack;    /* 1: rows are pushed together first */
    int longest; /* blocks of the longest row that there was or was planned */
    void *row_memory, *pool_memory;
} sbi_matrix_live;

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* Lets a compact matrix follow changes from now on. Its pattern has all that is counted here and nothing else (else
 * that stays for ever); rows that no cell names and in_use excludes are free.
 * cells    [cell_count][nodes_per_cell]; cells whose first node is < 0 are free
 * others   made: couplings besides; NULL: none
 * in_use   [row_count] or NULL: all
 * slack    share of rows in reserve, >= 0; with some, blocks have a quarter more
 * SB_ERROR_MEMORY leaves the matrix as it was. */
SBI_API sb_result sbi_matrix_make_live(sb_matrix *matrix, int cell_count, int nodes_per_cell, const int *cells,
                                       const sbi_matrix_couplings *others, const unsigned char *in_use, double slack,
                                       sb_error *error);
/* Memory to follow a change; change or others may be NULL. SB_ERROR_MEMORY leaves the matrix as it was. */
SBI_API sb_result sbi_matrix_reserve(sb_matrix *matrix, const sbi_mesh_change *change,
                                     const sbi_matrix_couplings *others, sb_error *error);
/* Memory for changes with so many new couplings, both ways. */
SBI_API sb_result sbi_matrix_reserve_plan(sb_matrix *matrix, int couplings, sb_error *error);
/* Follows the change reserved last; other reservations or changes in between are not allowed. Blocks have any values
 * then. Cost proportional to what changed, but a pass over all rows where parts come, go, meet
 * or get another first row. part_start and part_rows are right after sbi_matrix_list_parts only. */
SBI_API void sbi_matrix_follow(sb_matrix *matrix, const sbi_mesh_change *change);
/* Blocks that arrays beside the matrix need room for: as many as it may get without further memory. */
SBI_API int sbi_matrix_capacity(const sb_matrix *matrix);
/* The same of rows. */
SBI_API int sbi_matrix_row_capacity(const sb_matrix *matrix);
/* Which pattern it is at present: each change makes it another one; 0 of a compact matrix. */
SBI_API unsigned sbi_matrix_version(const sb_matrix *matrix);
/* Lists rows by part where a change has left that to be done; the arrays behind part_start and part_rows change. For
 * all who read them. */
SBI_API void sbi_matrix_list_parts(const sb_matrix *matrix);
/* Blocks that are in rows. */
SBI_API int sbi_matrix_used_blocks(const sb_matrix *matrix);
/* sparse.c: the identity for the diagonal block of a row that is not in use, which is fixed; and of all such rows, for
 * whoever writes all blocks. */
SBI_API void sbi_matrix_set_free_row(sb_matrix *matrix, int row);
SBI_API void sbi_matrix_set_free_rows(sb_matrix *matrix);
/* Whether places, columns, transposes, counts, free pieces and parts are consistent: for tests. SB_ERROR_STATE names
 * the first fault. */
SBI_API sb_result sbi_matrix_check_live(const sb_matrix *matrix, sb_error *error);

/* ---- sparse ---- */

/* Finds the connected parts of rows and lists them; part_of [row_count]. */
SBI_API void sbi_sparse_find_parts(sb_matrix *matrix, int *part_of);
/* Lists rows by part, once every row has one. */
SBI_API void sbi_sparse_list_parts(const sb_matrix *matrix, const int *part_of);
#endif

#endif /* SB_SPARSE_LIVE_H */
