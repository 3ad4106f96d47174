/* cut_private: what is inside an sb_cut. Internal.
 *
 * Tets are those of the uncut mesh, in the order of the body's cells at creation; each has a chain of pieces, the first
 * of which has the tet's number. Nodes of the uncut mesh keep their numbers. */
#ifndef SB_CUT_PRIVATE_H
#define SB_CUT_PRIVATE_H

#include "../body/body_private.h"
#include "../body/live_private.h"
#include "crossing.h"
#include "cut.h"
#include "parted.h"

typedef struct sbi_cut_piece {
    uint64_t points; /* of the lattice */
    int cell;        /* of the body */
    int next;        /* piece of the same tet with the next lowest point, or -1 */
} sbi_cut_piece;

/* A piece near what a call has parted, as it is to be. */
typedef struct sbi_cut_cell {
    uint64_t points;
    int tet;
    int piece;  /* that it is of now */
    int is_new; /* 1: another piece has that one's cell */
    int is_cut; /* 1: its tet falls into other pieces now */
    int cell;
    int old_nodes[4], nodes[4];
    unsigned short marks[4]; /* on the faces */
} sbi_cut_cell;

/* A class of the corners around a node: one node from now on. */
typedef struct sbi_cut_class {
    int root;
    int old;  /* its number so far */
    int has;  /* 1: the material at the node's place */
    int held; /* axes that a copy is supported along */
    int number;
} sbi_cut_class;

typedef struct sbi_cut_list {
    int *items;
    int count, capacity;
} sbi_cut_list;

struct sb_cut {
    sb_body *body; /* NULL: it is gone */
    sb_allocator allocator;
    int listener;
    int changing; /* 1: the change under way is our own */
    int stale;    /* 1: the body's mesh is not what we know */
    sbi_lattice lattice;

    int tet_count, node_end;
    int *tets;                 /* [tet_count][4] nodes */
    sb_index_table neighbours; /* [tet_count][4] across faces, -1: none */
    sb_index_lists node_tets;  /* tets of each node, ascending */

    sbi_cut_piece *pieces; /* [piece_capacity] */
    int piece_count, piece_capacity;
    sbi_cut_links links;
    sbi_cut_list origins;  /* [node] of the uncut mesh that it is a copy of, or itself */
    sbi_cut_list elements; /* [cell] tet */

    /* of a call; marks are 0 between calls */
    sbi_blade *blades;
    int blade_count, blade_capacity;
    unsigned char *tet_marks, *node_marks; /* [tet_count], [node_end] */
    int *cell_of;                          /* [tet_count] 1 + first of its records, or 0 */
    sbi_cut_list touched, parted;          /* tets */
    sbi_cut_cell *cells;
    int cell_count, cell_capacity;
    sbi_cut_list roots;     /* [cell_count][4] union-find over corners of the records */
    sbi_cut_class *classes; /* of one node */
    int class_count, class_capacity;
    int made_nodes, made_cells;
};

typedef struct sbi_cut_box {
    sb_vec3 low, high;
} sbi_cut_box;

enum { SBI_CUT_ALL_PARTS = -1 };
SB_INLINE int sbi_cut_is_of(const sb_cut *cut, int node, int part)
{
    return part == SBI_CUT_ALL_PARTS || cut->body->node_component[node] == part;
}

enum { SBI_CUT_TOUCHED = 1, SBI_CUT_PARTED = 2, SBI_CUT_NEAR = 4 };

/* Room for `more` items behind those that are there; 0: no memory. */
SBI_API int sbi_cut_grow(const sb_allocator *allocator, void **items, int *capacity, int count, int more, size_t size);
SBI_API int sbi_cut_list_grow(const sb_cut *cut, sbi_cut_list *list, int more);
/* Sets an item that there is room for; those between it and the last one are -1 then. */
SBI_API void sbi_cut_list_set(sbi_cut_list *list, int at, int value);
/* Room for so many more links; 0: no memory. */
SBI_API int sbi_cut_reserve_links(sb_cut *cut, int more);
/* Cuts the links of a connected part, or of all, that the blades cross in the body's present shape, and lists the tets
 * around them as touched. 0: no memory, and links are to be taken back. */
SBI_API int sbi_cut_sweep(sb_cut *cut, const sbi_crossing_frame *frame, int part);
/* Makes pieces, copies and cells of what the touched tets have become, by a change of the body's mesh. On failure
 * nothing has happened. */
SBI_API sb_result sbi_cut_part(sb_cut *cut, sb_error *error);
/* The cell of the body whose material is at xi of the tet that `cell` is of, see sb_body_find_cell: user is the cut.
 * Within a change of its own it is as after it. */
SBI_API int sbi_cut_find_cell(void *user, int cell, const sb_real xi[3]);
/* Forgets what tets have been touched. */
SBI_API void sbi_cut_clear(sb_cut *cut);

#endif /* SB_CUT_PRIVATE_H */
