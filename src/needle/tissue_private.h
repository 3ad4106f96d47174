/* tissue_private: what is inside a tissue. Floor 6, internal: tissue_matrix.c keeps the stiffness up to date with mesh
 * and rotations, tissue_precond.c preconditions, tissue_step.c steps; a room above couples rods to it.
 *
 * K is stored by nodes and edges of the mesh. A row holds the blocks right of and left of the diagonal, sorted by
 * column, in a piece of one pool that has room to spare; pieces come in a few sizes and are used again through a list
 * for each. An edge knows its two blocks and, as a ring, the tets that add to them; a tet knows its six edges. So a
 * step finds every block by index, and a change of topology touches the edges of changed tets only. Rows and rings are
 * sorted: the sums form in one order whatever the history, and K is a function of the mesh and the rotations, bit by
 * bit. (The other way, subtracting a tet's old blocks and adding the new, drifts.)
 */
#ifndef NDL_TISSUE_PRIVATE_H
#define NDL_TISSUE_PRIVATE_H

#include "tissue.h"

/* How a node takes part in a solve. */
enum {
    NDLI_ROW_FREE = 0,
    NDLI_ROW_HELD = 1,    /* fixed or prescribed: no unknown */
    NDLI_ROW_ABSENT = 2,  /* slot not in use */
    NDLI_ROW_COUPLED = 3  /* unknown, but left to another block of the preconditioner (a rod's) */
};

/* Rows and edges per task: fixed, so that partial sums do not depend on threads. */
enum { NDLI_SOLID_CHUNK = 256, NDLI_SOLID_BATCHES = 8 };

/* Pieces of the pool have (class + 1) NDLI_SOLID_PIECE places. */
enum { NDLI_SOLID_PIECE = 4, NDLI_SOLID_CLASSES = 64 };

/* Coefficients of a step of dt: dx = dt v + dt^2 (c0 a + beta a'), dv = dt ((1 - gamma) a + gamma a'),
 * A = mass M + stiffness K. */
typedef struct ndli_solid_scheme {
    sb_real dt, c0, beta, gamma;
    sb_real mass, stiffness;
} ndli_solid_scheme;

/* The coarse space: six rigid modes of each aggregate of nodes. u = t + w x arm. */
typedef struct ndli_solid_coarse {
    int count;          /* aggregates */
    int width;          /* of the band */
    int usable;         /* 1: the factor is there */
    int age;            /* steps since it was made; 0: to be made */
    int fresh_iterations; /* of the step it was made for */
    int wasted;         /* iterations beyond those in the steps since */
    int listed;         /* 1: lists are those of the present nodes */
    sb_real made_mass, made_stiffness; /* coefficients it was made with */
    int *start;         /* [count + 1] into nodes */
    sb_vec3 *centre;    /* [count] (m) */
    sb_real *inverse_radius; /* [count] (1/m) */
    double *factor;     /* [6 count][width + 1], room for a full one */
    double *unknown;    /* [6 count] */
    void *block;
} ndli_solid_coarse;

struct ndli_site; /* what needles share; see needle_state.h */

struct ndl_tissue {
    struct ndli_site *site; /* NULL: no needles */
    ndl_tissue_mesh mesh;
    sb_allocator allocator;
    sb_jobs jobs;
    sb_clock clock;
    ndl_integrator integrator;
    sb_real damping_mass, damping_stiffness;
    sb_vec3 gravity;
    sb_real lazy_angle, tolerance;
    int max_iterations;
    sb_real *lame; /* [material_count][2] lambda, mu (Pa) */
    int material_count;

    /* nodes: [node_room], vectors with one more to be read beyond */
    int node_room;
    sb_vec3 *force, *target, *target_velocity, *reaction;
    unsigned char *role;         /* NDLI_ROW_... */
    unsigned char *has_velocity; /* 1: target_velocity was given */
    unsigned char *node_dirty;   /* 1: a block of the row has changed */
    int *row_start, *row_count, *row_class; /* class -1: no piece */
    sb_real (*diagonal)[9];      /* K_ii (N/m) */
    sb_real (*inverse)[9];       /* A_ii^-1; zeros unless free */
    int *aggregate;
    int *coarse_nodes;           /* nodes by aggregate */
    sb_vec3 *arm;                /* from the aggregate's centre, over its radius */
    int *scratch;                /* zeros between uses */
    sb_vec3 *seen_x;             /* x at which forces and matrix were evaluated */
    sb_vec3 *internal;           /* elastic force on the nodes (N) */
    sb_vec3 *way;                /* what K acts on for the right-hand side (m) */
    sb_vec3 *rhs, *unknown, *residual, *search, *correction, *product;
    sb_vec3 *before;             /* accelerations at the start of the step (m/s^2) */
    double *partial;             /* [chunks][2] */
    void *node_block;

    /* tets: [tet_room]; lanes in batches of SB_POLAR_LANES */
    int tet_room;
    sb_real *gradients;   /* [batch][9][lanes] of nodes 1..3 (1/m) */
    sb_real *moduli;      /* [batch][2][lanes] V lambda, V mu (J); 0: slot not in use */
    sb_real *quats;       /* [batch][4][lanes] */
    sb_real *old_quats;   /* [batch][4][lanes] of the stiffness */
    sb_real *rotated;     /* [tet_room][16] R g of 4 nodes, V lambda, V mu, 0, 0: of the stiffness */
    sb_vec3 *corner_force; /* [4 tet_room] (N) */
    int *tet_edges;       /* [6 tet_room] or -1 */
    int *ring_next;       /* [6 tet_room] code 2 (6 t + pair) + flip of the next in the edge's ring, or -1 */
    unsigned char *stale_tet; /* 1: its stiffness is to be turned whatever its rotation */
    unsigned char *turned;    /* 1: its stiffness was turned in the present evaluation */
    double *batch_energy; /* [batch] (J) */
    void *tet_block;

    /* edges: [edge_room] */
    int edge_room, edge_end, free_edge;
    int *edge_nodes;      /* [2] nodes i < j; i < 0: not in use */
    int *edge_slots;      /* [2] places of (i, j) and (j, i) in the pool; free edges: [0] is the next */
    int *edge_ring;       /* first code */
    unsigned char *edge_dirty;
    void *edge_block;

    /* pool of rows: [slot_room] */
    int slot_room, slot_end;
    int free_pieces[NDLI_SOLID_CLASSES]; /* first place, linked through columns; -1 */
    int *columns, *slot_edge;
    sb_real (*blocks)[9]; /* with one sb_real to spare */
    void *slot_block;

    ndli_solid_coarse coarse;
    int broken;             /* 1: a change of the mesh found no memory: rows and edges are to be made anew */
    int changed;            /* 1: mesh, materials or supports changed since the last evaluation */
    int seen_end;           /* node_end of seen_x, 0: none */
    int acceleration_known;
    double elastic;         /* J, at seen_x */

    /* Newmark's linearised steps have no bound on their energy: ndl_tissue_step keeps a ledger of what there should be,
     * and steps with more take Euler, which damps. */
    int watched, calm;      /* 1: the ledger is kept; 1: the present step is Euler's */
    int led;                /* 1: needles lead nodes in the present step */
    int ledger_open;
    double ledger, next_ledger; /* J, before and after the present step is committed */
    double work;            /* J, of gravity, forces and supports in the last step */
    double work_unit;       /* J, sizes of its terms: for rounding */
    double left_at;         /* sum over x and v when the last step was done: tells when others have set them */

    ndli_solid_scheme scheme;
    uint64_t make;          /* hash of what cannot change: the first mesh, densities, how steps are done */
    int inverse_valid;      /* 1: `inverse` is that of the scheme but for dirty nodes */
};

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* ---- tissue_matrix: rest data, rows, edges, forces and stiffness ---- */

SB_INLINE int ndli_solid_chunks(int count) { return count / NDLI_SOLID_CHUNK + (count % NDLI_SOLID_CHUNK != 0); }
SB_INLINE int ndli_solid_is_node(const ndl_tissue *t, int node)
{
    return node >= 0 && node < t->mesh.node_end && t->mesh.node_flags[node] != 0;
}
/* Memory for so many node and tet slots (the mesh's capacities), and all rows, edges and rest data made anew from the
 * mesh. 0: no memory; what nodes know (supports, loads) is kept either way. */
NDLI_API int ndli_solid_rebuild(ndl_tissue *t);
/* The mesh's listener. */
NDLI_API void ndli_solid_changed(void *user, const ndl_mesh_change *change);
/* Memory for the mesh's capacities and a pool of so many places, so many edges; nothing else changes. 0: none. */
NDLI_API int ndli_solid_reserve(ndl_tissue *t, int slots, int edges);
/* Takes a tet out of the rings of its edges, and edges without tets away. */
NDLI_API void ndli_solid_leave(ndl_tissue *t, int tet);
/* Puts a tet into the rings of its edges; 0: no memory. */
NDLI_API int ndli_solid_join(ndl_tissue *t, int tet);
/* A slot out of use: no stiffness, no rotation. */
NDLI_API void ndli_solid_blank(ndl_tissue *t, int tet);
/* rotated = R g of the tets of the batch that are marked as turned, by old_quats: a function of these and of g. */
NDLI_API void ndli_solid_rotate(ndl_tissue *t, int batch);
/* Rest data of a tet from mesh and materials. */
NDLI_API void ndli_solid_measure(ndl_tissue *t, int tet);
/* internal = elastic forces at mesh.x; tets whose rotation has gone too far, or that are new, turn. */
NDLI_API void ndli_solid_forces(ndl_tissue *t);
/* K of those tets; returns how many there were. */
NDLI_API int ndli_solid_stiffness(ndl_tissue *t);
/* y = mass M x + stiffness K x in some rows; where a row has no unknown x is 0, or whatever shall act on the others. */
NDLI_API void ndli_solid_multiply_rows(const ndl_tissue *t, sb_real mass, sb_real stiffness, const sb_vec3 *x,
                                       sb_vec3 *y, int first, int last);
NDLI_API void ndli_solid_multiply(const ndl_tissue *t, sb_real mass, sb_real stiffness, const sb_vec3 *x, sb_vec3 *y);
/* Place of block (i, j), i != j, in the pool, or -1: no edge joins them. O(log row). */
NDLI_API int ndli_solid_find(const ndl_tissue *t, int i, int j);
NDLI_API void ndli_solid_free(ndl_tissue *t);

/* ---- tissue ---- */

/* NDLI_ROW_FREE, _HELD or _COUPLED of a node in use. */
NDLI_API void ndli_solid_set_role(ndl_tissue *t, int node, int role);

/* ---- tissue_precond ---- */

NDLI_API int ndli_solid_coarse_create(ndl_tissue *t);
/* A_ii^-1 where it changed, the coarse matrix when it is due; returns 1 when that was made. */
NDLI_API int ndli_solid_precond_update(ndl_tissue *t);
/* z = M^-1 r on free rows, 0 elsewhere: blocks and coarse space. Returns r.z. */
NDLI_API double ndli_solid_precondition(ndl_tissue *t, const sb_vec3 *r, sb_vec3 *z);
/* Nodes that a change made get the aggregate of the nearest source. */
NDLI_API void ndli_solid_coarse_changed(ndl_tissue *t, const ndl_mesh_change *change);

/* ---- tissue_step ---- */

/* A step in parts, for those who solve it together with something else. begin: forces, K, scheme, preconditioner and
 * the right-hand side `rhs` of A a' = rhs on rows with an unknown (0 elsewhere; what held nodes do is in it).
 * A = scheme.mass M + scheme.stiffness K. Nothing of the state changes before commit. */
NDLI_API sb_result ndli_solid_begin(ndl_tissue *t, sb_real dt, ndl_tissue_info *info, sb_error *error);
/* unknown = A^-1 rhs from 0. */
NDLI_API sb_result ndli_solid_solve(ndl_tissue *t, ndl_tissue_info *info, sb_error *error);

/* What is solved together with the tissue: more unknowns, and forces on rows of coupled nodes. Its functions see the
 * tissue's vectors of the present solve; NULL: the tissue alone. */
typedef struct ndli_solid_guest {
    void *user;
    void (*begin)(void *user);  /* residual += its right-hand side on coupled rows, = on its own; search = unknown */
    void (*settle)(void *user); /* residual -= product, of its own */
    void (*direct)(void *user, sb_real factor); /* search = correction + factor search, of its own */
    double (*multiply)(void *user);      /* product += its forces for `search`; returns search.product of that */
    void (*advance)(void *user, sb_real factor); /* unknown += factor search, residual -= factor product, of its own */
    double (*precondition)(void *user);  /* correction on coupled rows and its own; returns residual.correction */
} ndli_solid_guest;

/* Conjugate gradients in parts. */
typedef struct ndli_solid_cg {
    ndl_tissue *t;
    const ndli_solid_guest *guest;
    sb_real factor;
    double rz;      /* residual.correction */
    int iterations; /* in all runs */
} ndli_solid_cg;

/* residual = rhs - A unknown, */
NDLI_API void ndli_solid_cg_residual(ndli_solid_cg *cg);
/* and the first correction. */
NDLI_API void ndli_solid_cg_begin(ndli_solid_cg *cg);
/* Goes on until residual.correction <= target or max_iterations is reached. */
NDLI_API sb_result ndli_solid_cg_run(ndli_solid_cg *cg, double target, sb_error *error);
/* x, v, a at the end of the step from the accelerations `unknown`; SB_ERROR_DIVERGED changes nothing. */
NDLI_API sb_result ndli_solid_commit(ndl_tissue *t, sb_error *error);
/* After commit: how many iterations the step took, which tells when the coarse matrix is worn. */
NDLI_API void ndli_solid_wear(ndl_tissue *t, int iterations);
/* A_ii, and A_ij (0 and zeros when no edge joins them). */
NDLI_API sb_mat3 ndli_solid_node_block(const ndl_tissue *t, int node);
NDLI_API int ndli_solid_edge_block(const ndl_tissue *t, int i, int j, sb_mat3 *block);
#endif

#endif /* NDL_TISSUE_PRIVATE_H */
