/* direct_private: what is inside a sb_direct. Floor 1, internal: direct.c analyses, factors and solves,
 * direct_between.c multiplies by the inverse from both sides. */
#ifndef SB_DIRECT_PRIVATE_H
#define SB_DIRECT_PRIVATE_H

#include "direct_front.h"

typedef struct sbi_direct_piece {
    int first, last; /* columns */
    int row_count;   /* nodes: own columns and those below */
    int row_start;   /* into rows: own columns first */
    int child_count;
    size_t panel; /* first entry of its columns of L, [3 row_count] entries each */
} sbi_direct_piece;

enum { SBI_DIRECT_GROUPS = 8 }; /* of right-hand sides, that a panel serves while it is near */

struct sb_direct {
    sb_allocator allocator;
    void *memory; /* the one block behind all arrays */
    int kind;
    int node_count, block_count, piece_count;
    unsigned pattern_version; /* see sbi_matrix_version */
    int *position;            /* [node_count] column of a node */
    int *node;                /* [node_count] node of a column */
    sbi_direct_piece *pieces;
    int *rows;    /* columns' numbers, ascending in each piece */
    int *place;   /* [node_count] of a column among the rows of the present piece */
    int *run_end; /* [node_count] scratch: of a child's rows, where those end that are neighbours in its parent, too */
    sb_real *factor;
    sb_real *squares;  /* the stack */
    int *waiting;      /* [piece_count] scratch: pieces whose squares are on the stack */
    sb_real *signs;    /* [3 node_count] of D, by column: 1 or -1 */
    sb_real *sizes;    /* [3 node_count] largest entry of each row */
    sb_real *pack;     /* scratch of the fronts' arithmetic */
    sb_real *solution; /* [GROUPS][3 node_count][SBI_FRONT_GROUP] of a solve, by column */
    sb_real *gathered; /* [largest_front][SBI_FRONT_GROUP] */
    size_t factor_count, stack_count;
    int ready; /* 1: there is a factor */
    int wide;  /* of the fronts' arithmetic */
    sb_direct_info info;
};

#endif /* SB_DIRECT_PRIVATE_H */
