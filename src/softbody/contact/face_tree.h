/* face_tree: which faces of a moving surface a box in space may touch. Internal. Calls base only.
 *
 * Faces lie four to a leaf in the order that they are given in (along Morton's curve through the shape at rest), and
 * leaves under a binary tree without pointers: a level has a box for each two of the level below.
 *
 *     level 2          [        box        ]
 *     level 1     [   box   ]         [   box   ]
 *     level 0   [box]     [box]     [box]     [box]      four faces each
 *
 * A refit makes all boxes anew from where the nodes are, and where they will be; the order stays good however far the
 * surface moves, since neighbours stay neighbours. Boxes of single faces are made when a query asks for them: they are
 * few, and would be most of what a refit writes.
 *
 * A quadratic face goes beyond the box of its nodes. It lies within the box of its control points: the coefficients of
 * the same polynomial in Bernstein's form, which sums them with weights that are positive and sum to 1.
 *
 * Numbers are floats about an origin that goes with the surface; a query's box is widened by more than all rounding. */
#ifndef SB_FACE_TREE_H
#define SB_FACE_TREE_H

#include "../base/dense.h"

enum {
    SBI_FACE_TREE_LEAF = 4,   /* faces of a leaf */
    SBI_FACE_TREE_WIDEST = 9, /* nodes of a face */
    SBI_FACE_TREE_LEVELS = 32,
    SBI_FACE_TREE_BITS = 64 /* of a word of marks */
};

/* A box: its lower corner, then its upper one with the other sign, so that boxes join by minima alone. Numbers 3 and 7
 * mean nothing. */
typedef struct sbi_face_box {
    float corner[8];
} sbi_face_box;

/* Where a node is and will be, about the origin. */
typedef struct sbi_face_path {
    float start[4], end[4];
} sbi_face_path;

/* What there is to be room for. */
typedef struct sbi_face_tree_room {
    int faces;    /* in the tree */
    int nodes;    /* of these faces */
    int node_end; /* nodes are numbered below */
    int width;    /* most nodes of a face */
} sbi_face_tree_room;

/* The faces of a tree. */
typedef struct sbi_face_tree_source {
    int count;                  /* faces in the tree */
    const int *faces;           /* [count] their numbers, in the order of the leaves */
    const int *nodes;           /* of face f from nodes + f width on */
    const unsigned char *sizes; /* [face] nodes: 3 tri3, 4 quad4, 6 tri6, 8 quad8, 9 quad9 */
} sbi_face_tree_source;

typedef struct sbi_face_tree {
    sbi_face_tree_room room;
    int count, leaf_count, node_count;
    int size;             /* nodes of every face: room.width; 0: some have fewer */
    int *faces;           /* [4 leaf_count] by place; the last leaf repeats its last face */
    unsigned char *sizes; /* [4 leaf_count] */
    int *corners;         /* [4 leaf_count][room.width] nodes by their numbers in `nodes` */
    int *nodes;           /* [node_count] in the order in which the leaves need them */
    int *numbers;         /* [room.node_end] -1 between calls */
    sbi_face_box *ways;   /* [node_count] boxes of the nodes' ways */
    sbi_face_path *paths; /* [node_count] or NULL: no face can be quadratic */
    sbi_face_box *boxes;  /* leaves, then the levels above */
    int level_count, level_start[SBI_FACE_TREE_LEVELS], level_size[SBI_FACE_TREE_LEVELS];
    int first_node;  /* lowest of all, where the origin is: so that what a query finds does not depend on the order */
    sb_vec3 origin;  /* m */
    sb_real spacing; /* m: more than what rounding takes from a box */
    void *memory;
} sbi_face_tree;

/* An empty tree with room. 0: no memory. */
SBI_API int sbi_face_tree_create(const sbi_face_tree_room *room, const sb_allocator *allocator, sbi_face_tree *tree);
SBI_API void sbi_face_tree_free(sbi_face_tree *tree, const sb_allocator *allocator);
/* Puts faces into a tree that has room for them; a refit has to follow. */
SBI_API void sbi_face_tree_build(sbi_face_tree *tree, const sbi_face_tree_source *source);
/* Boxes that hold all faces with the nodes at x + s dt v (m), for all s in [0, 1]. v NULL: at x. */
SBI_API void sbi_face_tree_refit(sbi_face_tree *tree, const sb_vec3 *x, const sb_vec3 *v, sb_real dt);
/* Faces whose boxes meet [low, high] (m; +-SB_REAL_MAX: no bound): returns how many, and writes the first `capacity` of
 * them in ascending order. marks: [sbi_face_tree_words of the highest number + 1] zeros, and zeros again afterwards;
 * another one for each thread that asks. */
SBI_API int sbi_face_tree_query(const sbi_face_tree *tree, sb_vec3 low, sb_vec3 high, uint64_t *marks, int *faces,
                                int capacity);
/* Boxes that a query may leave out. */
typedef struct sbi_face_tree_groups {
    const int *first, *last; /* [boxes] first and last group of the faces below each */
    int left_out;            /* boxes that have this one alone; -1: none */
} sbi_face_tree_groups;
/* The same, without faces of boxes that are left out: others of the group may be found. */
SBI_API int sbi_face_tree_query_groups(const sbi_face_tree *tree, sb_vec3 low, sb_vec3 high,
                                       const sbi_face_tree_groups *groups, uint64_t *marks, int *faces, int capacity);
SB_INLINE int sbi_face_tree_words(int faces) { return faces / SBI_FACE_TREE_BITS + 1; }
/* Box of the face at a place (below count), as a query sees it. */
SBI_API void sbi_face_tree_place_box(const sbi_face_tree *tree, int place, sb_vec3 *low, sb_vec3 *high);

#endif /* SB_FACE_TREE_H */
