/* multigrid_level: what a level holds. Floor 1, internal to the multigrid. */
#ifndef SB_MULTIGRID_LEVEL_H
#define SB_MULTIGRID_LEVEL_H

#include "../base/owned.h"
#include "direct.h"
#include "multigrid.h"

#define SBI_MG_UNIT 32767.0f         /* largest number of 16 bits that is used */
#define SBI_MG_ONE 32766.96875f      /* what stands for 1 there: what rounding makes larger than 1 has room */
#define SBI_MG_WORD 2147416064.0     /* what stands for 1 in 32 bits: SBI_MG_ONE << 16 */
#define SBI_MG_MAX_WORD 2147418112.0 /* SBI_MG_UNIT << 16 */

enum {
    SBI_MG_MAX_LEVELS = 16,
    SBI_MG_ROWS = 64,      /* rows of a task: fixed, so that sums do not depend on threads */
    SBI_MG_THREADED = 256, /* levels with fewer rows are not worth waking a thread for */
    SBI_MG_DENSE = 64,     /* nodes that a level need not be coarsened for, */
    SBI_MG_SPARSE = 500,   /* and where moduli jump: 3 % of specks in 106,329 unknowns take 9 iterations so, 12 with
                            * 300. Half as many where the factor is dear: */
    SBI_MG_DEAR = 256,     /* it takes more multiply-adds than these times the blocks of the matrix. With a ball in
                            * an organ of 5,661 nodes of tet10 it took 2,400 times as many, an update 38 ms, now
                            * 5.4; */
    SBI_MG_DEAR_BLOCKS = 150000, /* smaller matrices count as one of so many blocks */
    SBI_MG_PACKED = 100000,      /* blocks of a coarser level from which it, too, is kept in 16 bits: smaller ones would
                                  * be 3 % faster so, but cut cells and plates at rest want their digits */
    SBI_MG_ISLANDS = 16,         /* groups of islands at most: so many tasks */
    SBI_MG_LANCZOS = 5,          /* steps of the estimate of the largest eigenvalue, */
    SBI_MG_LANCZOS_MOST = 12,    /* and on coarser levels of regions */
    SBI_MG_REACH_AGE = 16,       /* updates that make do with one */
    SBI_MG_AHEAD = 4096,    /* bytes of blocks asked for before they are read: as many as memory needs, which nearer
                             * caches do not mind */
    SBI_MG_ROWS_AHEAD = 16, /* diagonal blocks asked for before they are read, */
    SBI_MG_BLOCKS_AHEAD =
        128 /* and blocks of a list: coarse sums take 0.4 of the time so, with 32 0.7, with 256 0.35 */
};

/* The box of a region in cells; each cell is cut into six tets along its diagonal (Kuhn), in which displacements are
 * linear: rigid motions and uniform strains of the finer level are then motions of the coarser one, too. */
typedef struct sbi_cubes {
    double low[3], extent[3]; /* m */
    double edge;              /* about that of its cells (m) */
    int cells[3];             /* 0 along an axis without extent */
    int tet;                  /* 1: a region smaller than a cell; one tet around it takes half as many nodes */
    int64_t first;            /* number of its first point */
} sbi_cubes;

/* One level. Blocks are 3x3, row-major; vectors have four floats a node, the fourth 0. All arrays that are read as
 * vectors have room for reading past their end.
 *
 * Most of what a cycle reads is the finest matrix, more than caches hold. So that one, and a coarser one that is large
 * where no moduli jump (rounding tells on parts a thousand times as stiff), is kept in 16 bits an entry, as
 * S^-1 A S^-1 with S = sqrt(largest diagonal entry) of each node: no entry of a positive definite A is then beyond 1.
 * The vectors of such a level are those of this scaled system (S x, S^-1 r), and S enters where levels meet. The
 * rounding is symmetric and leaves the cycle positive definite; coarser levels are made from A as it was before. */
typedef struct sbi_mg_level {
    int row_count, block_count;
    sb_vec3 *positions; /* [row_count] (m) of a level of the user's, otherwise NULL */
    sb_vec3 *places;    /* [row_count] (m) where a lattice without regions is laid over the nodes, otherwise NULL: */
    double *spacings;   /* [row_count] (m) their mean distances to the nearest ones, */
    sbi_cubes *lattice; /* and that lattice, for levels made later; */
    int64_t *points;    /* [row_count] the points of the finer level's lattice that the nodes are, or NULL */
    int *row_start, *columns; /* the pattern: columns ascend in each row */
    int *diagonal;            /* [row_count] */
    float *blocks;            /* [block_count][9], but for level 0 */
    int16_t *packed;          /* [block_count][9] in units of 1 / SBI_MG_ONE, or NULL */
    uint16_t *rest;           /* [block_count][9] of level 0, for the product in 32 bits an entry; NULL in float builds,
                               * and where there are regions: the rounding of stiff parts turns a slow motion of theirs
                               * into another (six slabs at rest take 19 iterations to 1e-2 by it, 12 without) */
    float *scale;             /* [row_count][4] of packed levels: S for free components, 0 for prescribed ones; then
                               * 1 / S */
    float *mend;              /* [row_count][12] of level 0 where there are regions: what rounding took from the
                               * diagonal blocks, rows of four; otherwise NULL */
    float *inverse;           /* [row_count][12] of diagonal blocks, rows of four, 0 in directions without stiffness */
    float *x, *r, *d, *e;     /* [row_count][4] solution, residual, direction, the next direction */
    double *partial;          /* [tasks] sums of each task's rows */
    double bound;             /* of the eigenvalues of D^-1 A */
    int degree;               /* of the Chebyshev smoother; one more where the body is `wide` */
    int twice;                /* 1: goes through its cycle twice for each visit from above */

    /* the way to the next coarser level, when there is one */
    int *parent_start, *parents; /* row i moves with parents[parent_start[i] ..] */
    float *shares;               /* weights of the parents */
    int *child_start, *children; /* the same from the coarser level's side: [its rows + 1] */
    float *child_shares;
    int *mixed_start;   /* [row_count + 1] into mixed: blocks of A P, row by row */
    int *slots;         /* for each block of A and each parent of its column: which block of its row of A P takes it */
    int *slot_start;    /* [row_count + 1] */
    int *mixed_columns; /* [mixed_count] the coarser level's node of each, */
    float *mixed;       /* [mixed_count][9] and its values */
    /* Block q of P^T (A P) on and above the diagonal is the sum of shares times blocks of A P, sum_start[q] and on; one
     * below it is the transpose of block twins[q]. */
    size_t *sum_start; /* [coarser blocks + 1] */
    int *sum_blocks;   /* with SBI_MG_BLOCKS_AHEAD more, 0 */
    float *sum_shares;
    int *twins; /* [coarser blocks] */
} sbi_mg_level;

/* Parts of a body that are stiff in one piece, where moduli jump. Coarse nodes that span a jump cannot follow the stiff
 * side without dragging the soft one along, so each region has coarse nodes of its own, on all levels; the linear
 * motions of the whole are still motions of theirs. */
typedef struct sbi_mg_regions {
    int row_count;
    int count;       /* 0: no jumps, and no arrays */
    int *of;         /* [row_count] region of each of the finest nodes */
    sb_real *moduli; /* [count] largest (Pa) */
    int *sizes;      /* [count] how many of the finest nodes */
} sbi_mg_regions;

/* Islands that are solved together: small stiff parts of the finest level, see multigrid_island.c. */
typedef struct sbi_mg_island_group {
    int count;
    int ready;         /* 1: the last update found a factor */
    int *rows;         /* [count] ascending */
    sb_real *exact;    /* [count][3] */
    sb_matrix matrix;  /* what the rows have among themselves */
    sb_direct *direct; /* factors it */
} sbi_mg_island_group;

enum { SBI_MG_SEA = 0, SBI_MG_SHORE = 1, SBI_MG_ISLAND = 2 }; /* a node of no island; next to one; of one */

typedef struct sbi_mg_islands {
    int count; /* of groups; 0: there are no islands, and no arrays */
    int ready; /* 1: all have a factor of the last update; 0: the cycle does without */
    sbi_mg_island_group groups[SBI_MG_ISLANDS];
    int *rows;           /* of all groups, one after the other, */
    sb_real *exact;      /* and their solutions */
    unsigned char *side; /* [rows of level 0] */
    float *motion;       /* [rows of level 0][4] S x of islands, 0 elsewhere */
} sbi_mg_islands;

struct sbi_multigrid {
    sb_jobs jobs;
    int level_count;
    sbi_mg_level levels[SBI_MG_MAX_LEVELS];
    sbi_mg_regions regions; /* where the moduli jump, for whoever makes levels like these */
    sbi_mg_islands islands;
    int small;          /* nodes that the coarsest level may have */
    int couples_parts;  /* see sbi_multigrid_couples_parts */
    int wide;           /* 1: nearly incompressible: eigenvalues that smoothers have to damp lie far apart */
    int softened;       /* how often the bounds were doubled since the last update */
    sbi_mg_reach reach; /* of level 0 */
    /* the coarsest level of n unknowns: a dense factor, a sparse one, or none */
    int factored;             /* 1: there is one of the last update; 0: the level is smoothed only */
    double *factor;           /* [n][n] */
    double *pivot, *solution; /* [n] */
    sb_direct *direct;
    sb_matrix coarsest;  /* what it factors */
    sb_real *exact;      /* [n] */
    double *spread;      /* [rows of level 0][4] S x of the x to multiply by; NULL where there is no rest */
    double matrix_scale; /* of the last update */
    double deviation;    /* see sbi_multigrid_deviation */
    int longest_row;     /* of level 0 */
    sbi_owned owned;     /* its arrays; bytes: of everything */
};

/* ---- multigrid_coarsest ---- */

/* A matrix with the pattern that rows of a level have among themselves, its blocks in the level's order, and what
 * factors it. place[row] is a row's number there or -1; rows and place NULL: all rows. 0: no memory. */
SBI_API int sbi_mg_take_direct(sbi_multigrid *m, const sbi_mg_level *level, const int *rows, int row_count,
                               const int *place, sb_matrix *matrix, sb_direct **direct);

/* Where moduli jump: takes the last level's factor, if that is small; *dear: 1 when it would cost too much, and a
 * smaller level is wanted. 0: no memory. */
SBI_API int sbi_mg_weigh_coarsest(sbi_multigrid *m, int *dear);
/* What the coarsest level is solved with, unless it is too large for that; 0: no memory. */
SBI_API int sbi_mg_take_coarsest(sbi_multigrid *m);
/* Factors the coarsest level's matrix; 0: it has to do with its smoother. */
SBI_API int sbi_mg_factor_coarsest(sbi_multigrid *m);
/* x = A^-1 r of it */
SBI_API void sbi_mg_solve_coarsest(sbi_multigrid *m);

/* ---- multigrid_island ---- */

/* Finds the islands, where there are regions. 0: no memory. */
SBI_API int sbi_mg_take_islands(sbi_multigrid *m);
SBI_API void sbi_mg_free_islands(sbi_mg_islands *islands);
/* Factors their blocks of the matrix times scale. */
SBI_API void sbi_mg_factor_islands(sbi_multigrid *m, const sb_matrix *matrix, double scale);
/* Before a cycle for the residual in[row_count][3] times factor: sets their motion with the rest held. After it: their
 * x with the rest where the cycle has put it. */
SBI_API void sbi_mg_leave_islands(sbi_multigrid *m, const sb_real *in, sb_real factor);
SBI_API void sbi_mg_reach_islands(sbi_multigrid *m, const sb_real *in, sb_real factor);

/* ---- multigrid_region ---- */

/* Regions of the nodes of a pattern. 0: no memory. */
SBI_API int sbi_mg_find_regions(const sb_matrix *pattern, const sb_real *moduli, const sb_vec3 *positions,
                                const sb_allocator *allocator, sbi_mg_regions *regions);
SBI_API int sbi_mg_copy_regions(const sbi_mg_regions *from, const sb_allocator *allocator, sbi_mg_regions *regions);
SBI_API void sbi_mg_regions_free(const sb_allocator *allocator, sbi_mg_regions *regions);
/* Joins all but the `most` largest regions that the labels of a level's nodes name with neighbours: a small stiff part
 * counts for little in coarse cells much larger than it. 0: no memory. */
SBI_API int sbi_mg_limit_regions(const sbi_mg_level *level, const sbi_mg_regions *regions, int most,
                                 const sb_allocator *allocator, int *labels);

/* Interpolation rows in the making, with arrays of their own. */
typedef struct sbi_mg_rows {
    int coarse_count;
    int *start; /* [rows + 1] */
    int *nodes;
    float *weights;
    sb_vec3 *positions; /* [coarse_count] */
    int64_t *points;    /* [coarse_count] of the lattice that they are, or NULL: there is none */
    int *labels;        /* [coarse_count] region of each, or NULL */
} sbi_mg_rows;

SBI_API void sbi_mg_rows_free(const sb_allocator *allocator, sbi_mg_rows *rows);

/* ---- multigrid_match ---- */

/* What a level has in common with the same level of a multigrid made before; all zeros: nothing. */
typedef struct sbi_mg_match {
    const sbi_mg_level *old; /* that level */
    int *was;                /* [rows] which of its rows each row was, or -1; no two were the same one */
    unsigned char *same;     /* [rows] 1: the row's columns are those that it had, in the order they had */
} sbi_mg_match;

/* For a level of so many rows: none was one before. 0: no memory, and the match is empty. */
SBI_API int sbi_mg_begin_match(const sbi_mg_level *old, int row_count, const sb_allocator *allocator,
                               sbi_mg_match *match);
SBI_API void sbi_mg_free_match(const sb_allocator *allocator, sbi_mg_match *match);
/* Sets `same` when `was` is there. */
SBI_API void sbi_mg_match_columns(const sbi_mg_level *level, sbi_mg_match *match);
/* Of the finest level, whose nodes have the numbers they had; empty without `like`. 0: no memory. */
SBI_API int sbi_mg_match_finest(const sbi_multigrid *m, const sbi_multigrid *like, sbi_mg_match *match);

/* ---- multigrid_plan ---- */

/* Values and vectors of a level whose counts are set. 0: no memory. */
SBI_API int sbi_mg_take_values(sbi_multigrid *m, sbi_mg_level *level);
/* The level below the last one from interpolation rows, and all plans between the two. What `match` says the last one
 * has in common with one before is taken over from there; it is of the new level then. 0: no memory. */
SBI_API int sbi_mg_add_level(sbi_multigrid *m, const sbi_mg_rows *rows, sbi_mg_match *match);

/* ---- multigrid_lattice ---- */

/* What a lattice is laid over. */
typedef struct sbi_mg_nodes {
    const sbi_mg_level *level;
    const sbi_mg_match *match;     /* of the level */
    double *spacings;              /* [rows] or NULL: these two get what the level keeps of their name, */
    sbi_cubes *lattice;            /* if there are no labels */
    const sb_vec3 *positions;      /* [rows] (m) */
    const sbi_mg_regions *regions; /* read where there are labels */
    const int *labels;             /* [rows] region of each, or NULL: all are one */
} sbi_mg_nodes;

/* Interpolation from a lattice of tets laid over the nodes, one for each region, with edges about `ratio` times as long
 * as theirs; `thin_ratio` for stiff regions that are hardly more than their surface. 0: no memory. */
SBI_API int sbi_mg_lattice(const sbi_mg_nodes *nodes, double ratio, double thin_ratio, const sb_allocator *allocator,
                           sbi_mg_rows *rows);

#endif /* SB_MULTIGRID_LEVEL_H */
