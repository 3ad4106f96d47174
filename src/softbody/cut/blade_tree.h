/* blade_tree: which blades are near a box. Internal. Floor 4, calls base only.
 *
 * Blades are put in the order of a curve through space (Morton 1966), four to a leaf; over the leaves lie pairs of
 * them, pairs of pairs, and so on, each with its box. The caller owns the arrays. */
#ifndef SB_BLADE_TREE_H
#define SB_BLADE_TREE_H

#include "crossing.h"

enum { SBI_BLADE_LEAF = 4, SBI_BLADE_LEVELS = 32 };

typedef struct sbi_blade_box {
    sbi_int3 low, high;
} sbi_blade_box;

typedef struct sbi_blade_tree {
    const sbi_blade *blades;
    int count;
    int *order;           /* [count] blades along the curve */
    sbi_blade_box *boxes; /* [sbi_blade_tree_boxes(count)] level after level, leaves first */
    int level_count, level_first[SBI_BLADE_LEVELS], level_size[SBI_BLADE_LEVELS];
} sbi_blade_tree;

/* Boxes of a tree over so many blades. */
SB_INLINE int sbi_blade_tree_boxes(int count) { return 2 * (count / SBI_BLADE_LEAF + 1) + SBI_BLADE_LEVELS; }
/* Makes the tree in its arrays. codes, scratch [count] */
SBI_API void sbi_blade_tree_make(sbi_blade_tree *tree, const sbi_blade *blades, int count, uint64_t *codes,
                                 int *scratch);

/* Box of all blades; there are some. */
SB_INLINE const sbi_blade_box *sbi_blade_tree_box(const sbi_blade_tree *tree)
{
    return tree->boxes + tree->level_first[tree->level_count - 1];
}

/* A walk over the blades whose boxes meet one. */
typedef struct sbi_blade_walk {
    sbi_blade_box box;
    int levels[2 * SBI_BLADE_LEVELS], places[2 * SBI_BLADE_LEVELS], waiting; /* boxes yet to be looked into */
    int at, end;                                                             /* of a leaf, in the tree's order */
} sbi_blade_walk;
SBI_API void sbi_blade_walk_begin(const sbi_blade_tree *tree, const sbi_blade_box *box, sbi_blade_walk *walk);
/* The next blade, in no order that means anything, or -1. */
SBI_API int sbi_blade_walk_next(const sbi_blade_tree *tree, sbi_blade_walk *walk);

#endif /* SB_BLADE_TREE_H */
