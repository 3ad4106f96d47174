/* grid_private: what the makers of a grid work on. */
#ifndef SBI_GRID_PRIVATE_H
#define SBI_GRID_PRIVATE_H

#include "grid.h"

#include <string.h>

/* ---- grid_cell.c ---- */

/* A box of the octree. Bits of shapes: bit 0 the outer one, bit i the inner shape i - 1. */
typedef struct sbi_grid_box {
    sb_vec3 centre, half;         /* m */
    unsigned undecided;           /* shapes whose surface may cut the box */
    unsigned inside;              /* shapes that the whole box is inside of */
    int near[SB_GRID_MAX_SHAPES]; /* triangle of each surface that was closest to the last centre, or -1 */
} sbi_grid_box;

/* What one region has of a cell, in shares of the cell. */
typedef struct sbi_grid_part {
    double phi[8];   /* share of each octant */
    double mass[36]; /* int N_a N_b of the pairs a <= b */
    int64_t points;
} sbi_grid_part;

/* A cell that may be kept. */
typedef struct sbi_grid_candidate {
    int box;   /* number in the lattice */
    int level; /* of its octree */
    int part;  /* its parts start at this times slot_count, or -1: full of one region */
    int slot;  /* that region; of a cut cell: the one with most of it */
    unsigned undecided, inside;
    int first_cell; /* of the body's mesh */
    int cell_count; /* there; 0: the cell is dropped */
} sbi_grid_candidate;

typedef struct sbi_grid_work {
    const sb_grid_def *def;
    sb_grid *grid;
    int shape_count, slot_count;
    unsigned open;                               /* shapes, as bits, whose signs only winding numbers give */
    unsigned char *doubtful[SB_GRID_MAX_SHAPES]; /* [triangles] 1: nor does this one; NULL: it crosses nothing */
    int slot_of[SB_GRID_MAX_SHAPES];             /* slot of each shape's region, or -1: empty */
    int regions[SB_GRID_MAX_SHAPES];             /* [slot_count] */
    unsigned *undecided, *inside;                /* [boxes]; inside SBI_GRID_BAD: a distance was not finite */
    int candidate_count, cut_count;
    sbi_grid_candidate *candidates; /* [candidate_count] */
    int *cut;                       /* [cut_count] candidates that are cut */
    sbi_grid_part *parts;           /* [cut_count][slot_count] */
    sbi_grid_part full;             /* of a cell inside */
    double done, total;             /* tasks, for progress */
    int first_task;                 /* of the slab being run */
    sb_task task;
} sbi_grid_work;

/* Walks an octree and hands points on: to the sums of the cell's parts, or to where finite cells are written. */
typedef struct sbi_grid_walk {
    const sbi_grid_work *work;
    sb_vec3 centre; /* of the cell (m) */
    int level;
    sbi_grid_part *parts; /* [slot_count], or NULL: */
    int *at;              /* [slot_count] next point of each region, counted from the cell's first */
    int first_cell;       /* of the body's mesh */
    int bad;              /* 1: a distance was not finite */
} sbi_grid_walk;

SB_INLINE const sb_shape *sbi_grid_get_shape(const sb_grid_def *def, int shape)
{
    return shape == 0 ? &def->outer : def->inner + (shape - 1);
}

/* Signs of local coordinates at the corners, in VTK's order. */
SB_INLINE double sbi_grid_sign(int node, int axis)
{
    static const signed char sign[8][3] = {{-1, -1, -1}, {1, -1, -1}, {1, 1, -1}, {-1, 1, -1},
                                           {-1, -1, 1},  {1, -1, 1},  {1, 1, 1},  {-1, 1, 1}};
    return (double)sign[node][axis];
}

SBI_API sb_result sbi_grid_find_doubtful(sbi_grid_work *work, sb_error *error);
/* Looks which surfaces keep clear of what is within `reach` (m) of the box's middle. Returns 0 when a distance is not
 * finite. */
SBI_API int sbi_grid_decide(const sbi_grid_work *work, sb_real reach, sbi_grid_box *box);
/* Slot of the region that the whole box is of, -1 where it is empty, -2 when that is open. */
SBI_API int sbi_grid_slot(const sbi_grid_work *work, unsigned undecided, unsigned inside);
SBI_API sbi_grid_box sbi_grid_make_box(sb_vec3 centre, sb_vec3 half, unsigned undecided, unsigned inside);
/* Middle of a lattice box `index` cells from the origin, or of a block of `width` cells from there. */
SBI_API sb_vec3 sbi_grid_middle(const sb_grid *grid, int x, int y, int z, int width);
SBI_API sb_vec3 sbi_grid_cell_middle(const sb_grid *grid, int box);
SBI_API void sbi_grid_shape_functions(const double xi[3], double shape[8]);
/* Gradients (1/m) in a brick of this size. */
SBI_API void sbi_grid_gradients(sb_vec3 size, const double xi[3], sb_real *gradients);
/* Local coordinates of a point in the cell with this middle. */
SBI_API void sbi_grid_local(const sb_grid *grid, sb_vec3 middle, sb_vec3 point, double xi[3]);
/* What a point inside adds to the sums of its region: `share` of the cell. */
SBI_API void sbi_grid_sum_point(sbi_grid_part *part, const double xi[3], double share, int octant);
/* Point p of eight in a box: Gauss's two along each axis, the first axis fastest. */
SBI_API sb_vec3 sbi_grid_gauss_point(const sbi_grid_box *box, int p);
SBI_API void sbi_grid_walk_cell(sbi_grid_walk *walk, const sbi_grid_candidate *candidate);

/* ---- grid_cut.c ---- */

SB_INLINE int sbi_grid_is_sparse(const sb_grid_def *def) { return def->method == SB_GRID_SPARSE || def->level == 0; }

/* Runs task(work, i) for i in [0, count), by slabs, and reports progress up to `share` of the whole. */
SBI_API sb_result sbi_grid_run(sbi_grid_work *work, sb_task task, int count, double share, sb_error *error);
SBI_API sb_result sbi_grid_classify(sbi_grid_work *work, sb_error *error);
/* Task: the parts of cut cell `index`. A cell in which the points of its level find nothing is looked at more closely,
 * so that the cells of a grid do not change with the level, and none that is kept is without mass. */
SBI_API void sbi_grid_measure_cell(void *user, int index);
SBI_API double sbi_grid_part_share(const sbi_grid_part *part);
/* Share of a cut cell that is inside; *largest: the region that has most of it. */
SBI_API double sbi_grid_cell_share(const sbi_grid_work *work, const sbi_grid_candidate *c, int *largest);
/* Decides what is kept, and where its cells of the body's mesh start. *cells and *body_cells: how many there are. */
SBI_API sb_result sbi_grid_number_cells(sbi_grid_work *work, int *cells, int *body_cells, sb_error *error);

/* ---- grid_fill.c ---- */

SBI_API size_t sbi_grid_lattice_nodes(const int *counts);
SBI_API sb_result sbi_grid_build(sbi_grid_work *work, int *numbers, sb_error *error);

/* ---- grid.c ---- */

enum {
    SBI_GRID_BLOCK = 4,       /* cells along each edge of a block that is looked at at once */
    SBI_GRID_PROBE_LEVEL = 4, /* how finely the inside of a cell is looked for when the level asked for finds none */
    SBI_GRID_SLAB = 64        /* tasks between two calls of progress */
};

/* What the boxes of a lattice turned out to be. */
enum { SBI_GRID_BAD = 1 << SB_GRID_MAX_SHAPES }; /* no bit of a shape */

#endif /* SBI_GRID_PRIVATE_H */
