/* tissue: the dynamics of the tissue that needles work in: corotated linear tets whose mesh changes while it moves.
 * Floor 6. */
#ifndef NDL_TISSUE_H
#define NDL_TISSUE_H

#include "api.h"
#include "tissue_mesh.h"

/* What a region is made of. */
typedef struct ndl_tissue_material {
    sb_real young;   /* Pa, > 0 */
    sb_real poisson; /* in (-1, 0.5); tet4 lock above 0.35, see sb_check_report */
    sb_real density; /* kg/m^3, > 0 */
} ndl_tissue_material;

typedef enum ndl_integrator {
    NDL_NEWMARK = 1, /* average acceleration (beta 1/4, gamma 1/2): second order */
    NDL_EULER = 2    /* implicit Euler: first order, damps */
} ndl_integrator;

/* What a tissue is made from. Start from ndl_default_tissue_def(), set mesh and materials. */
typedef struct ndl_tissue_def {
    const sb_mesh *mesh;                  /* tet4 (m); copied */
    const ndl_tissue_material *materials; /* [material_count] by region, or one for all; copied */
    int material_count;
    const int *fixed_nodes;   /* [fixed_count] or NULL: held where they are; see ndl_tissue_fix */
    int fixed_count;
    ndl_integrator integrator; /* default NDL_NEWMARK */
    sb_real damping_mass;      /* Rayleigh alpha (1/s), >= 0; default 0 */
    sb_real damping_stiffness; /* Rayleigh beta (s), >= 0; default 0.005: Newmark needs some in large motions */
    sb_vec3 gravity;           /* m/s^2; default 0 */
    sb_real slack;             /* share of nodes and tets to have in reserve, in [0, 1000]; default 0.2 */
    sb_real lazy_angle;        /* a tet's stiffness is turned when its rotation is further than this from the one it
                                * has (|R - R_old|, about the angle in rad), in [0, 1]: the tangent is then wrong by a
                                * share of 2 lazy_angle at most, forces are exact. Default 0.01; 0: every step */
    sb_real tolerance;         /* of a step's solve: sqrt(r.M^-1 r) relative to its start, in (0, 1); default 1e-4 */
    int max_iterations;        /* of a step's solve, >= 1; default 200 */
    sb_allocator allocator;    /* default malloc */
    sb_jobs jobs;              /* default inline; the bits do not depend on it */
    sb_clock clock;            /* for ndl_tissue_info's times; default NULL */
    unsigned cookie;           /* set by ndl_default_tissue_def */
} ndl_tissue_def;

NDL_API ndl_tissue_def ndl_default_tissue_def(void);

/* Functions that return an sb_result refuse a NULL tissue; the others need one. */
typedef struct ndl_tissue ndl_tissue;

/* What a step did. */
typedef struct ndl_tissue_info {
    int iterations;        /* of the linear solve */
    sb_real residual;      /* sqrt(r.M^-1 r) relative to its start */
    int capped;            /* 1: max_iterations ended the solve, whose result was taken */
    int refreshed;         /* tets whose stiffness was turned, or is new */
    int coarse_refreshed;  /* 1: the preconditioner's coarse matrix was made anew: every ten steps, and when dt,
                            * damping or supports change */
    int calmed;            /* 1: the energy had grown by more than came in, and the step was one of Euler */
    double seconds_force;  /* with a clock, otherwise 0: rotations and forces, */
    double seconds_matrix; /* stiffness, right-hand side and preconditioner, */
    double seconds_solve;  /* conjugate gradients, */
    double seconds_total;  /* and the whole call */
} ndl_tissue_info;

/* A tissue at rest in the mesh's shape. All memory that stepping needs is taken here; later only changes of the mesh
 * ask for more, when slack is used up. On failure *tissue is untouched: SB_ERROR_ARGUMENT (field named), _MATERIAL
 * (region named), _INDEX (fixed node), _NOT_FINITE, _MESH, _MEMORY. */
NDL_API sb_result ndl_tissue_create(const ndl_tissue_def *def, ndl_tissue **tissue, sb_error *error);
NDL_API void ndl_tissue_destroy(ndl_tissue *tissue); /* NULL is fine */

/* The mesh, for a remesher and for reading. x, v and a may be set between steps; fixed flags and the listener are the
 * tissue's. Valid until the tissue is destroyed. */
NDL_API ndl_tissue_mesh *ndl_tissue_get_mesh(ndl_tissue *tissue);

/* ---- supports and loads: stay until changed ----
 * node: a slot in use (SB_ERROR_INDEX). SB_ERROR_NOT_FINITE and SB_ERROR_ARGUMENT change nothing either. What is said
 * of a node that a split made is forgotten when the split is undone. */

/* Holds the node where it is; remeshing then leaves it where it is in the material, too. */
NDL_API sb_result ndl_tissue_fix(ndl_tissue *tissue, int node);
/* Holds the node, and takes it to `position` (m) in the next step, where it has `velocity` (m/s) at the end; NULL: the
 * mean velocity of its way there. After that step it rests there. */
NDL_API sb_result ndl_tissue_prescribe(ndl_tissue *tissue, int node, sb_vec3 position, const sb_vec3 *velocity);
NDL_API sb_result ndl_tissue_release(ndl_tissue *tissue, int node);
NDL_API int ndl_tissue_is_held(const ndl_tissue *tissue, int node); /* 0 also when there is no such node */
/* Dead force (N); it replaces the one before. */
NDL_API sb_result ndl_tissue_set_force(ndl_tissue *tissue, int node, sb_vec3 force);
NDL_API sb_result ndl_tissue_set_gravity(ndl_tissue *tissue, sb_vec3 gravity);
NDL_API sb_result ndl_tissue_set_damping(ndl_tissue *tissue, sb_real alpha, sb_real beta);
/* Young's modulus and Poisson's ratio of a region (0 where one material is for all); density cannot change. */
NDL_API sb_result ndl_tissue_set_material(ndl_tissue *tissue, int region, sb_real young, sb_real poisson,
                                          sb_error *error);

/* ---- stepping ---- */

/* Advances by dt (s, > 0): one linear system, solved for accelerations a',
 *     A a' = f(x, v) - K (dt v + dt^2 (1/2 - beta) a) - C dt (1 - gamma) a,   A = M + beta dt^2 K + gamma dt C,
 * with lumped M, K = R K0 R^T (the corotated tangent without the change of R) and C = alpha M + beta_s K; Euler has
 * beta = gamma = 1 and no dt^2 (1/2 - beta) a. Held nodes reach their places exactly.
 * Linearised steps of Newmark may make energy in large motions. A ledger of energy and work sees to that: when there
 * is a tenth more than came in, a step is done by Euler, which damps (info->calmed).
 * Solved by conjugate gradients with 3x3 blocks and a coarse space of 6 rigid modes per about 64 nodes.
 * info may be NULL. Failures: SB_ERROR_ARGUMENT; SB_ERROR_MEMORY, a change of the mesh found no memory for the matrix
 * and there still is none; SB_ERROR_DIVERGED, something is not finite (node named). Then positions, velocities and
 * accelerations are as before, and the tissue can go on. Allocates nothing but after such a change. */
NDL_API sb_result ndl_tissue_step(ndl_tissue *tissue, sb_real dt, ndl_tissue_info *info, sb_error *error);

/* ---- readings: no allocation ----
 * Arrays are by node slot, [mesh->node_end], of nodes in use; valid until the mesh next changes. */
NDL_API const sb_vec3 *ndl_tissue_positions(const ndl_tissue *tissue);  /* m */
/* positions[nodes of the def's mesh] (m): where the material is now that was at those nodes. Once needles or a remesher
 * have moved nodes in the material these are not the nodes' positions, and they alone are what an sb_embedding or
 * sb_embedding_mapping of the def's mesh goes by (sb_embedding_update, sb_embedding_forces): with ndl_tissue_positions
 * it would be wrong by millimetres, and nothing could tell. As long as no node is moved both are the same bits.
 * SB_ERROR_ARGUMENT for NULL. Cost: of a copy and, per node moved, of a walk through the mesh. */
NDL_API sb_result ndl_tissue_original_positions(const ndl_tissue *tissue, sb_vec3 *positions);
NDL_API const sb_vec3 *ndl_tissue_velocities(const ndl_tissue *tissue); /* m/s */
/* Force (N) of the supports on the tissue at the end of the last step, 0 on free nodes: with gravity and forces the
 * rate of momentum. */
NDL_API const sb_vec3 *ndl_tissue_reactions(const ndl_tissue *tissue);
typedef struct ndl_tissue_energies {
    sb_real elastic; /* J */
    sb_real kinetic; /* J */
} ndl_tissue_energies;
NDL_API ndl_tissue_energies ndl_tissue_get_energies(const ndl_tissue *tissue);
NDL_API sb_vec3 ndl_tissue_momentum(const ndl_tissue *tissue); /* kg m/s */
/* Block (i, j) of the stiffness matrix K (N/m), as the last step used it; zeros where there is none. */
NDL_API sb_mat3 ndl_tissue_stiffness(const ndl_tissue *tissue, int i, int j);

#endif /* NDL_TISSUE_H */
