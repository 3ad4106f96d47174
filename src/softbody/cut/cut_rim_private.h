/* cut_rim_private: what closes a fine skin that is cut, during one call. Internal. */
#ifndef SB_CUT_RIM_PRIVATE_H
#define SB_CUT_RIM_PRIVATE_H

#include "cut_fine_private.h"

enum { SBI_RIM_SLOT = 5 };

/* How often, in sum, something goes along the line between two points: a table of open addresses over pairs of them. */
typedef struct sbi_rim_chain {
    int (*slots)[SBI_RIM_SLOT]; /* 1 + lower point or 0, higher point, ways up less ways down, what of these has not
                                 * been listed yet, 1: it is in a list of lines */
    int size;                   /* a power of two */
} sbi_rim_chain;

typedef struct sbi_rim {
    sbi_rim_chain chain;    /* borders of lips, and the ways of rims along them */
    int first_lip, lip_end; /* triangles of lips and walls */

    /* Borders of lips. Their points have numbers of their own, by which fine->lip_edges goes here. */
    int point_count;
    int *number_of;           /* [vertices] of a point of the skin, or -1 */
    int *vertex_of, *cell_of; /* [point_count] a vertex that is there, and the cell that a lip there moves with */
    int *tet_of;              /* [lip edges] of the cell */
    int *beside_at, *beside;  /* points beside a point */
    int *edges_at, *edges_of; /* lip edges by the nodes of their cells */

    /* A search for a way. */
    int search;
    int *seen, *depth, *came_from; /* [point_count] */
    int *queue;

    /* Seams. */
    int *edge_from, *excess; /* [vertices] an edge that begins there, or -1; more edges begin there than end */
    int *next_from;          /* [seam edges] the next one that begins at the same vertex */
    int seam_count, is_closed;
    int *seam, *cells;       /* [seam_count] vertices of the seam at work, cells of the edges behind them */
    int *goes_to, *position; /* [seam_count + 1] point of the borders; where in the walk that is */
    int *walk;               /* points along the borders */
    int walk_count;
    int *jumps; /* [jump_count][2] lines of walks that are no borders */
    int jump_count;

    /* What is left when all walks have been. */
    int *rest_from, *rest_to, *rest_next; /* a line that begins at a point, or -1; of lines, the next one that does */
    int rest_count;
    int *stacked, *stack; /* 1 + place of a point in the stack, or 0 */
    int *ring;            /* of a cap */
    int open_edges;
} sbi_rim;

SBI_API void sbi_rim_chain_add(sbi_rim_chain *chain, int from, int to);
/* 1 once for each time that the lines from a point to another are more than those back. */
SBI_API int sbi_rim_chain_list(sbi_rim_chain *chain, int from, int to);
/* A step of a walk between points of the borders. */
SBI_API void sbi_rim_chain_step(const sb_cut_fine *fine, sbi_rim *rim, int from, int to);
/* A surface of triangles in a polygon, counter-clockwise, of three corners or more, whose triangles there is room for.
 * ring: [count] scratch. */
SBI_API void sbi_rim_cap(sb_cut_fine *fine, const int *corners, int count, int cell, int *ring);
/* Caps whatever the chain does not cancel of borders and jumps; 0: no memory. */
SBI_API int sbi_rim_cap_rest(sb_cut_fine *fine, sbi_rim *rim);

#endif /* SB_CUT_RIM_PRIVATE_H */
