/* precond_private: what is inside an sb_preconditioner. Floor 1, internal: precond.c smooths, precond_lower.c has
 * its triangular factors, precond_pieces.c cuts the pieces, precond_coarse.c moves them, precond_save.c keeps it. */
#ifndef SB_PRECOND_PRIVATE_H
#define SB_PRECOND_PRIVATE_H

#include "../base/bytes.h"
#include "direct.h"
#include "../base/float4.h"
#include "../base/owned.h"
#include "precond.h"
#include "precond_fsai.h"

enum {
    SBI_PRECOND_MAX_ATTEMPTS = 18,
    SBI_PRECOND_MAX_SHIFT = 64,    /* beyond a row's length the shifted matrix is dominated by its diagonal, so that the
                                    * factor of any positive definite one exists */
    SBI_PRECOND_RELAX_FIRST = 16,  /* successful updates before a shift is lowered on trial */
    SBI_PRECOND_RELAX_LAST = 1024, /* the wait doubles with every failed trial up to this */
    SBI_PRECOND_NODES_PER_PIECE = 85,
    SBI_PRECOND_MAX_PIECES = 64,
    SBI_PRECOND_MULTIGRID_BLOCKS = 140000, /* measured on beams and livers of most elements */
    SBI_PRECOND_HALVED_ROWS = 1000,        /* below, a second thread gains next to nothing: 0.27 for 0.28 ms with 637 */
    SBI_PRECOND_BETWEEN = 6,               /* of the nodes at most one in so many may be between the halves */
    SBI_PRECOND_AHEAD = 8                  /* blocks asked for before they are read */
};

/* A cut of a set of nodes into halves, which are cut on. */
typedef struct sbi_piece_split {
    sb_vec3 low, high; /* box of its nodes (m) */
    int axis;          /* across which it is cut */
    int within;        /* the split whose half it is, or -1 */
    int last, first;   /* the nodes on either side of the cut: that of the first half and that of the second */
} sbi_piece_split;

/* How pieces were cut: tells whether nodes that have moved since can be cut otherwise. */
typedef struct sbi_piece_cuts {
    int room, split_count;   /* room: pieces and splits */
    sbi_piece_split *splits; /* [room] */
    int *split_of;           /* [row_room] the smallest set that each node is in, or -1 */
    int *axis;               /* [room] along which a piece follows the one before it; -1: it is the first of its part */
    sb_vec3 *positions;      /* [row_room] */
    int *places;             /* [row_room] the first node in the same place as each */
} sbi_piece_cuts;

/* The pieces' motions. Piece a has the 6 coarse unknowns 6a .. 6a+5: a translation and a rotation about its
 * centre, in units of its radius, so that both have the size of a displacement. (A Z) is stored by piece:
 * entry e couples piece a (piece_entry[a] <= e < piece_entry[a + 1]) with node entry_node[e], one of its own
 * or next to it. */
typedef struct sbi_precond_coarse {
    int piece_count, size; /* size = 6 piece_count */
    int piece_room;        /* of a matrix that follows: pieces that there is memory for; otherwise 0 */
    sbi_piece_cuts cuts;   /* of such a matrix */
    int cuts_tell;         /* 1: the pieces are those of the cuts */
    int ready;             /* 1: it has values */
    int *piece_start;      /* [piece_count + 1] into piece_nodes */
    int *piece_nodes;      /* [row_count] nodes by piece */
    int *piece_of;         /* [row_count] */
    int *piece_entry;      /* [piece_count + 1] */
    int *entry_node;       /* [entries] */
    int *entry_start;      /* [entries + 1] into entry_blocks */
    int *entry_blocks;     /* [block_count] matrix blocks (node, j) with j in the piece */
    sb_real *places;       /* [row_count][4] position relative to the piece's centre over its radius */
    float *arms;           /* [row_count][4] the same, rounded */
    float *free;           /* [row_count][4] 1 for free components, 0 for prescribed ones */
    float *coupling;       /* [entries][6][4] rows x, y, z of A Z: translations, then rotations */
    int *reach;            /* [piece_count] where the rows of a piece end */
    size_t *row_at;        /* [piece_count] where the six rows of a piece begin in matrix */
    double *matrix;        /* upper triangle of Z^T A Z, then of its Cholesky factor: rows from their piece's first
                            * unknown to its reach */
    double *inverse;       /* [size] inverse pivots, 0 for motions that the pieces do not have */
    double *solution;      /* [size] */
    sb_vec3 *positions;    /* [row_count] as last given */
} sbi_precond_coarse;

struct sb_preconditioner {
    sb_jobs jobs;
    sb_precond_kind kind;
    int power;
    int row_count, block_count, lower_count;
    uint64_t pattern_hash;
    unsigned pattern_version; /* see sbi_matrix_version */
    /* of a matrix that follows: the arrays are for as many rows and blocks as it has room for, and what depends on the
     * pattern is made anew by the first update after a change, from matrix and rest shape alone */
    int row_room, block_room, longest_room; /* 0: the matrix does not follow */
    int stale;                              /* 1: the pattern has changed since, */
    int recut;                              /* 1: or but the rest shape */
    int wanted_pieces;                      /* of the def */
    const sb_vec3 *rest; /* [row_count] rest shape that pieces are cut in, borrowed; NULL: no pieces */
    int *scratch;        /* [8 row_room + block_room + 1]: 9 row_room + 1 at least */
    sb_vec3 *centres;    /* [row_room] */
    int ready;           /* 1: updated or loaded */
    double matrix_scale; /* power of two that brought the mean diagonal of the smoothed matrix near 1 */
    /* lower triangle by rows, in the order of elimination: two halves that do not touch, then what is between them */
    int part[4];      /* where they begin in the order, and its end */
    int *order;       /* [row_count] the node i that is eliminated k-th */
    int *start;       /* [row_count + 1] of the row of order[k] */
    int *columns;     /* [lower_count] nodes j of each row, all eliminated before i, in that order */
    int *source;      /* [lower_count] matrix block (j, i) */
    int *below_start; /* [row_count + 1] of each node, into: */
    int *below;       /* [lower_count][2] nodes eliminated after it, the last of them first, and their blocks with it */
    float *lower;     /* [lower_count][12] L of M = (I + L) D (I + L)^T */
    float *inverse;   /* [row_count][12] D^-1 */
    float *middle;    /* [row_count][4] (I + L)^-1 r, or G r */
    float *result;    /* [row_count][4] z, scaled */
    /* IC0: for each block (i, j) the pairs (i, m), (j, m) with m eliminated before j: place in row i, index of the
     * block (j, m) */
    size_t *pair_start; /* [lower_count + 1] */
    int *pairs;         /* [pair_room][2] */
    size_t pair_room;
    int unlisted; /* 1: there is no room for the pairs; they are found again by each update */
    int *place;   /* [row_room] of each node in the order, of a matrix that follows */
    int *in_row;  /* [2][row_room] -1 between rows; of each half, in such a one */
    int *found;   /* [2][2 longest_room] pairs of the block at work in each half */
    int longest;  /* blocks of the longest row */
    float *row;   /* [2][longest or longest_room][12] transposed blocks of the rows at work, one in each half */
    int bad[2];   /* node of the first bad pivot of each half, or -1 */
    int relaxing; /* 1: the update at work tries a lower shift */
    double trial; /* its shift */
    int attempts, successes, wait;
    double shift;
    sbi_fsai fsai;
    sbi_multigrid *multigrid;
    sb_direct *direct; /* Cholesky */
    sb_real *exact;    /* [row_count][3] what it solves, and the solution */
    /* warping: M^-1 = R S R^T on the free components, with the inverse diagonal on those prescribed now */
    int turned;           /* 1: there are rotations */
    float *turns;         /* [row_count][12] R */
    float *held;          /* [row_count][4] scaled inverse diagonal of prescribed components, 0 for free ones */
    unsigned char *fixed; /* [row_count] masks of prescribed components */
    sbi_precond_coarse coarse;
    sbi_owned owned; /* its arrays; bytes: of everything */
};

/* What is done beside the making of A Z: task(user, 0 .. count - 1), then, beside the factor of Z^T A Z, last(user,
 * 0). */
typedef struct sbi_precond_beside {
    sb_task task, last; /* last: or NULL */
    void *user;
    int count;
} sbi_precond_beside;

/* What tasks see. */
typedef struct sbi_precond_job {
    sb_preconditioner *p;
    const sb_matrix *a;
    const sb_vec3 *positions; /* NULL: where they were */
    const sb_real *r;
    sb_real *z;
    double scale;                     /* of r: a power of two */
    int with_result;                  /* restriction: of r - A result, not r */
    const sbi_precond_beside *beside; /* or NULL */
} sbi_precond_job;

/* r_i for the smoother: rounded, and where there are rotations turned back, without what is prescribed. */
SBI_FORCE_INLINE sbi_float4 sbi_precond_enter(const sb_preconditioner *p, const sb_real *r, size_t i, sb_real scale)
{
    sbi_float4 v = sbi_f4_round(r + 3 * i, scale);
    if (!p->turned)
        return v;
    for (int k = 0; p->fixed[i] && k < 3; k++)
        if (p->fixed[i] >> k & 1)
            SBI_F4(v, k) = 0;
    return sbi_f4_rows(v, p->turns + 12 * i);
}

/* The power of two that brings `size` near 1: to 0.5 at least, below 1. */
SBI_API double sbi_precond_power(double size);

/* ---- precond_lower ---- */

/* Takes the memory of L; halved: in two halves where that leaves few nodes between them. 0 when there is none. */
SBI_API int sbi_precond_make_lower(sb_preconditioner *p, const sb_matrix *a, int halved);
/* L for the present pattern of a matrix that follows. */
SBI_API void sbi_precond_shape_lower(sb_preconditioner *p, const sb_matrix *a, int halved);
/* inverse = D^-1 of A's diagonal blocks: node of one that is not positive definite, or -1. */
SBI_API int sbi_precond_invert_diagonals(sb_preconditioner *p, const sb_matrix *a);
/* L of SSOR, after the diagonals */
SBI_API void sbi_precond_fill_ssor(sb_preconditioner *p, const sb_matrix *a);
/* An update of IC(0): begin says how many halves there are, each of which any thread may factor; then comes the end. */
SBI_API int sbi_precond_begin_ic0(sb_preconditioner *p);
SBI_API void sbi_precond_factor_half(sb_preconditioner *p, const sb_matrix *a, int half);
SBI_API sb_result sbi_precond_end_ic0(sb_preconditioner *p, const sb_matrix *a, sb_error *error);
/* result = M^-1 r */
SBI_API void sbi_precond_sweep(const sbi_precond_job *job);

/* A coordinate of a node. */
SBI_FORCE_INLINE sb_real sbi_precond_coordinate(const sb_vec3 *positions, int node, int axis)
{
    return axis == 0 ? positions[node].x : axis == 1 ? positions[node].y : positions[node].z;
}

/* ---- precond_pieces ---- */

/* Cuts the nodes into some `pieces` compact pieces of like size, each within one connected part, and one at least for
 * each part; some more where lips of cuts lie in them, up to twice as many. nodes[row_count] by piece, parts one after
 * the other, and piece_of[row_count]. Returns the number of pieces. scratch [8 row_count + 1], centres [row_count]:
 * scratch. cuts: notes how, or NULL; with room for `pieces`. */
SBI_API int sbi_precond_make_pieces(const sb_matrix *a, const sb_vec3 *positions, int pieces, int *scratch,
                                    sb_vec3 *centres, int *nodes, int *piece_of, sbi_piece_cuts *cuts);
/* Whether such a cut of the same pattern at other positions would give the same again; 0 also where that is not sure.
 * scratch [5 row_count], centres [row_count]: scratch. */
SBI_API int sbi_precond_pieces_stay(const sb_matrix *a, const sb_vec3 *positions, sbi_piece_cuts *cuts,
                                    const int *piece_of, int piece_count, int *scratch, sb_vec3 *centres);

/* ---- precond_coarse ---- */

/* Cuts the nodes into some `pieces` and takes the memory of their motions; 0 when there is none. */
SBI_API int sbi_precond_make_coarse(sb_preconditioner *p, const sb_matrix *a, const sb_vec3 *positions, int pieces);
/* Takes the memory for a matrix that follows and has room for so many pieces' rows; 0 when there is none. */
SBI_API int sbi_precond_take_coarse(sb_preconditioner *p, int pieces);
/* Pieces of the present pattern of such a matrix; pieces 0: none. stale 0: it is the last call's pattern, so that what
 * depends on it and on the pieces stays where these do. */
SBI_API void sbi_precond_shape_coarse(sb_preconditioner *p, const sb_matrix *a, int pieces, int stale);
/* Z^T A Z and A Z at positions[row_count], or where they were (NULL), and what is done beside, unless NULL. */
SBI_API void sbi_precond_update_coarse(sb_preconditioner *p, const sb_matrix *a, const sb_vec3 *positions,
                                       const sbi_precond_beside *beside);
/* z = result + Z (Z^T A Z)^-1 Z^T (r - A result), or of r alone, in the units of r and z */
SBI_API void sbi_precond_correct(const sbi_precond_job *job);
/* to = r - A Z (Z^T A Z)^-1 Z^T r */
SBI_API void sbi_precond_project(const sbi_precond_job *job, sb_real *to);

#endif /* SB_PRECOND_PRIVATE_H */
