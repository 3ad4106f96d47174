/* assembly: loops over integration points (energy, internal force, tangent). Floor 2, internal.
 *
 * Work is cut into chunks of neighbouring cells. Chunks that share a node get different colours; colours run one
 * after the other and the chunks of a colour in any order on any threads, so sums form in the same order whatever
 * the number of threads. Chunk size depends on the number of cells only. */
#ifndef SB_ASSEMBLY_H
#define SB_ASSEMBLY_H

#include "domain.h"
#include "material.h"
#include "../solve/sparse.h"

/* Springs of stiffness k (N/m) between sums of displacements s = sum w u that are 0 at rest, with weights that sum to
 * 0: energy k/2 s.s, besides that of the cells. All nodes of a row are coupled in the matrix. */
typedef struct sbi_inner_rows {
    int count;
    int *start, *nodes; /* [count + 1], [start[count]] */
    sb_real *weights;   /* [start[count]] */
    sb_real *stiffness; /* [count] */
    void *memory;       /* the one block behind the arrays */
} sbi_inner_rows;

/* A tie between two cells of one element that stand on copies of its nodes: energy k/2 sum_ab G_ab d_a.d_b with the
 * jumps d_a of their displacements at node a. G = sum_q w_q N(q) N(q)^T over points q of the face between them, so
 * that it is k/2 sum_q w_q |jump at q|^2: nothing in any rigid motion of both together. Nodes that both have
 * have no jump; the others of both cells are coupled in the matrix. */
enum { SBI_GLUE_NODES = 10, SBI_GLUE_GRAM = 55 }; /* at most */
typedef struct sbi_glue_tie {
    int cells[2];
    int nodes[2][SBI_GLUE_NODES]; /* of the cells */
    sb_real gram[SBI_GLUE_GRAM];  /* G (m), see sbi_glue_at; 0 behind what the cells' nodes need */
    sb_real stiffness;            /* k (Pa) */
} sbi_glue_tie;
typedef struct sbi_glue {
    int count, capacity;
    int nodes;          /* of a cell: 4 or 10 */
    sbi_glue_tie *ties; /* [capacity] */
} sbi_glue;
/* Place of G_ab between cells with so many nodes, and how many places there are. */
SB_INLINE int sbi_glue_at(int nodes, int a, int b)
{
    return a <= b ? a * (2 * nodes - 1 - a) / 2 + b : b * (2 * nodes - 1 - b) / 2 + a;
}
SB_INLINE int sbi_glue_gram(int nodes) { return nodes * (nodes + 1) / 2; }

typedef struct sbi_patches sbi_patches; /* see assembly_patch.h */

typedef struct sbi_assembly {
    const sb_domain *domain;
    const sb_material *materials; /* [material_count] */
    int material_count;
    const int *cell_material;      /* [cell_count] index into materials */
    const sb_real *cell_stiffness; /* [cell_count] > 0 that the stresses of each cell are multiplied by, borrowed; NULL
                                    * (and of a mesh that changes): 1 */
    sb_material *shares;           /* [material_count][2] what a cell's points and its mean point evaluate at present:
                                    * the shares of a B-bar cell (otherwise the whole), relaxed for the present step */
    sb_material *relaxing;         /* [material_count][2] what their Prony terms relax */
    const sb_vec3 *second_fibres;  /* [cell_count] of a second family, borrowed; or NULL */
    const sb_vec3 *fibres;         /* [cell_count] unit directions at rest or 0, borrowed; there when a material has
                                    * fibres */
    const sb_jobs *jobs;
    const sb_vec3 *reference;   /* [node_count] (m) */
    const sbi_inner_rows *rows; /* what holds besides the cells, borrowed; or NULL */
    const sbi_glue *glue;       /* and what ties cells to each other */
    sbi_patches *patches;       /* and what holds the volume of domain->cell_patch; NULL without */
    int fold_fallback;          /* 1: forces give a folded-over cell one rotation. Only for linearised steps, which no
                                 * energy watches: the rule makes it jump */
    const sb_vec3 *came_from; /* [node_count] displacements before the last increment, borrowed: exact tangents take the
                               * stress that was expected from there; NULL: the one that is */
    sb_real energy_unit;      /* sum of w (lambda + 2 mu) (J): energy densities are differences of numbers of the
                               * size of the moduli, so this times epsilon is their rounding error */
    int batched;              /* 1: tet4 or tet10 with every material corotated: the batched loops hold */
    int wide;                 /* and on this processor as SBI_WIDEN has them */
    sb_quat *rotations;       /* [cell_count][points_per_cell] warm starts of the polar rotations */
    sb_quat *saved_rotations; /* [cell_count][points_per_cell] for sbi_assembly_restore_rotations */
    int *scatter;             /* [cell_count][n (n + 1) / 2] matrix block of the pair (a, b), a <= b */
    int chunk_size, chunk_count;
    int colour_count;
    int *colour_start;     /* [colour_count + 1] into colour_chunks */
    int *colour_chunks;    /* [chunk_count] */
    sb_real *chunk_energy; /* [chunk_count] (J) */
    int *chunk_bad_cell;   /* [chunk_count] first cell with an inadmissible F, or -1 */

    /* memory of materials with Prony terms, NULL before the first */
    int viscous;        /* 1: some material has terms now */
    int terms;          /* most terms that the memory has room for */
    sb_real *history;   /* [cell_count][points_per_cell][1 + terms][6] S0 at the last end of a step, then h_i
                         * (Pa), in the order 00 11 22 01 12 02; as much again for what is saved of it */
    sb_real *prestress; /* [cell_count][points_per_cell][6] H of the present step (Pa) */

    /* tet4 and tet10 with corotated material (see assembly_batch.h): cells in batches of vector lanes, blocks gathered
     * edge by edge. n nodes and q points per cell */
    int mixed;                /* 1: not all cells have the same lambda / mu */
    sb_real *batch_gradients; /* [batch_count][q][3 (n - 1)][SB_POLAR_LANES]: gradients of nodes 1 .. n - 1 */
    sb_real *batch_moduli;    /* [batch_count][q][3][SB_POLAR_LANES]: w lambda, w mu, sqrt(w mu) */
    sb_real *batch_quats;     /* tet4: [batch_count][4][SB_POLAR_LANES], in place of `rotations` */
    sb_real *saved_batch_quats;
    sb_real *rotated;               /* [cell_count][n][q][3] sqrt(w mu) R g_a, and more to spare */
    sb_real *ratios;                /* [cell_count] lambda / mu */
    int *pair_start;                /* [block_count + 1] into pairs; only blocks above the diagonal have any */
    int *pairs;                     /* [cell_count][n (n - 1) / 2] cells and two of their nodes */
    sb_real *node_stiffness;        /* of clouds: [node_count] (N/m) mean of each node's three diagonal entries of K,
                                     * which no rotation changes */
    sb_real *node_diagonal;         /* of clouds: [node_count] for what a step has there */
    struct sbi_assembly_live *live; /* of a mesh that changes, see assembly_live.h; otherwise NULL */
} sbi_assembly;

/* 1: points have the materials' share of shear, and mean points or patches that of changes of volume. */
SB_INLINE int sbi_assembly_is_split(const sbi_assembly *assembly)
{
    return assembly->domain->mean_points || assembly->domain->cell_patch;
}
/* What the stresses of a cell are multiplied by. */
SB_INLINE sb_real sbi_assembly_stiffness(const sbi_assembly *assembly, int e)
{
    return assembly->cell_stiffness ? assembly->cell_stiffness[e] : (sb_real)1;
}
/* Cells that arrays have room for. */
SB_INLINE int sbi_assembly_cell_room(const sb_domain *domain)
{
    return sbi_max_int(domain->cell_capacity, domain->cell_count);
}
/* The cell after the last one of a chunk. */
SB_INLINE int sbi_assembly_chunk_end(const sbi_assembly *assembly, int chunk)
{
    int begin = chunk * assembly->chunk_size;
    return begin + sbi_min_int(assembly->chunk_size, assembly->domain->cell_count - begin);
}
/* Reals that a point remembers. */
SB_INLINE size_t sbi_memory_stride(const sbi_assembly *assembly) { return 6 * (1 + (size_t)assembly->terms); }

/* ---- assembly_layout ---- */

/* Takes the arrays that the domain, the matrix pattern and the number of materials ask for from the arena (measuring
 * or for real). */
SBI_API void sbi_assembly_layout(sbi_assembly *assembly, const sb_domain *domain, int block_count, int material_count,
                                 sbi_arena *arena);
/* Colours the chunks; node_colours: scratch [node_count]. */
SBI_API void sbi_assembly_colour(sbi_assembly *assembly, uint64_t *node_colours);

/* ---- assembly ---- */

/* Fills scatter maps, chunks, colours and identity rotations. node_colours: scratch [node_count]. */
SBI_API void sbi_assembly_prepare(sbi_assembly *assembly, const sb_matrix *matrix, uint64_t *node_colours);
/* The same for another pattern of the matrix: only where blocks are has changed. pair_start: [block_count + 1], used
 * from now on by batched bodies, which sbi_assembly_has_pairs tells. */
SBI_API void sbi_assembly_remap(sbi_assembly *assembly, const sb_matrix *matrix, int *pair_start);
SBI_API int sbi_assembly_has_pairs(const sbi_assembly *assembly);
/* Says what each cell is made of; both arrays are borrowed. Call again when a material changes. Materials with fibres
 * need assembly->fibres, those with Prony terms room for their memory. */
SBI_API void sbi_assembly_set_materials(sbi_assembly *assembly, const sb_material *materials, int material_count,
                                        const int *cell_material);
/* Forgets the warm starts: rotations become the identity. */
SBI_API void sbi_assembly_reset_rotations(sbi_assembly *assembly);
/* Keeps the warm starts, and brings them back: a step that was undone leaves no trace, to the last bit. Bringing them
 * back also leaves a step that sbi_assembly_begin_step began. */
SBI_API void sbi_assembly_save_rotations(sbi_assembly *assembly);
SBI_API void sbi_assembly_restore_rotations(sbi_assembly *assembly);

/* force[node_count] (N) = internal force at displacements u (m); updates the rotations. Returns -1, or the first
 * cell whose F the material does not admit (then `force` is unusable). */
SBI_API int sbi_assembly_force(sbi_assembly *assembly, const sb_vec3 *u, sb_vec3 *force);
/* matrix = factor * tangent at u. Uses the rotations that the last sbi_assembly_force left at the same u. */
SBI_API int sbi_assembly_tangent(sbi_assembly *assembly, const sb_vec3 *u, sb_tangent_kind kind, sb_real factor,
                                 sb_matrix *matrix);
/* The same with a factor (>= 0) for the cells of each material, factors[material_count]; `factor` is that of all that
 * is no cell. */
SBI_API int sbi_assembly_weighted_tangent(sbi_assembly *assembly, const sb_vec3 *u, sb_tangent_kind kind,
                                          const sb_real *factors, sb_real factor, sb_matrix *matrix);
/* y = K x with the K that sbi_assembly_tangent gives for SB_TANGENT_QUASI and 1, without a matrix; x and y:
 * [node_count]. Returns 0, and leaves y, for cells or materials that have to be assembled: see sbi_assembly.batched.
 * For one product this is the faster way; for many with the same K it depends (see sb_body_multiply_tangent). */
SBI_API int sbi_assembly_multiply(sbi_assembly *assembly, const sb_vec3 *x, sb_vec3 *y);
/* The same for those rows only that `held` [node_count] marks (others are a part of the sum); NULL: all. */
SBI_API int sbi_assembly_multiply_held(sbi_assembly *assembly, const sb_vec3 *x, const unsigned char *held, sb_vec3 *y);
/* force = that of u, as sbi_assembly_force, and K x, of batched tet4 without rows and glue; x NULL: that of u alone.
 * turned 1: the rotations are those of u already, and stay. */
SBI_API void sbi_assembly_force_along(sbi_assembly *assembly, const sb_vec3 *u, const sb_vec3 *x, int turned,
                                      sb_vec3 *force);
/* x . K x of that K, for batched tet4 without rows and glue; takes no more than the half of the product's time. */
SBI_API sb_real sbi_assembly_work_along(sbi_assembly *assembly, const sb_vec3 *x);
/* *energy (J) = energy at u, whose derivative the force is; returns -1 or the first inadmissible cell. Rotations
 * stay as they are. */
SBI_API int sbi_assembly_energy(sbi_assembly *assembly, const sb_vec3 *u, sb_real *energy);
/* A cell takes over the warm starts and the memory of one of another assembly with as many points and terms; then
 * sbi_assembly_begin_step(to, 0). */
SBI_API void sbi_assembly_copy_cell(sbi_assembly *to, int cell, const sbi_assembly *from, int old);
/* Gives up what is not of the layout. */
SBI_API void sbi_assembly_free(sbi_assembly *assembly, const sb_allocator *allocator);

/* force [node_count] += the force at u of the cells of material number `index`, were they made of another one of its
 * model: of any numbers that stress is linear in, also negative ones, without Prony terms. Rotations stay. Not for a
 * single rotation. Returns -1 or the first inadmissible cell. */
SBI_API int sbi_assembly_add_share(sbi_assembly *assembly, const sb_vec3 *u, int index, const sb_material *material,
                                   sb_vec3 *force);

/* ---- assembly_rows ---- */

SBI_API void sbi_rows_add_force(const sbi_inner_rows *rows, const sb_vec3 *u, sb_vec3 *force);
SBI_API sb_real sbi_rows_energy(const sbi_inner_rows *rows, const sb_vec3 *u);
SBI_API void sbi_rows_add_tangent(const sbi_inner_rows *rows, sb_real factor, sb_matrix *matrix);

/* ---- assembly_glue ---- */

SBI_API void sbi_glue_add_force(const sbi_glue *glue, const sb_vec3 *u, sb_vec3 *force);
SBI_API sb_real sbi_glue_energy(const sbi_glue *glue, const sb_vec3 *u);
SBI_API void sbi_glue_add_tangent(const sbi_glue *glue, sb_real factor, sb_matrix *matrix);

/* ---- assembly_memory: materials with Prony terms ----
 * Within a step of dt the stress is S = S_relaxed(F) + H with H constant (quasi-linear viscoelasticity, Taylor, Pister
 * and Goudreau 1970), so that the step has the energy W_relaxed + H : E. Between steps dt is 0: energy, force and
 * tangent are those of a sudden change from the present state. Bodies without Prony terms pay one test per call. */

/* Room for the memory of so many terms; SB_ERROR_MEMORY changes nothing. What is remembered stays. */
SBI_API sb_result sbi_assembly_reserve_memory(sbi_assembly *assembly, int terms, const sb_allocator *allocator,
                                              sb_error *error);
/* The part of the state that the memory is, one array of *bytes bytes; NULL and 0 without Prony terms. Whoever
 * overwrites it calls sbi_assembly_begin_step(assembly, 0) afterwards. */
SBI_API sb_real *sbi_assembly_memory(sbi_assembly *assembly, size_t *bytes);
/* Energy, force and tangent become those at the end of a step of dt (s; 0: of a jump; infinite: long after) from the
 * memory's state. Returns 1 when they may differ from before, so that a force at hand is stale. Pure: begin(0) brings
 * back the state between steps to the last bit. */
SBI_API int sbi_assembly_begin_step(sbi_assembly *assembly, sb_real dt);
/* The step of dt ended at u: the memory moves on, and dt is 0 again. Returns as above. */
SBI_API int sbi_assembly_end_step(sbi_assembly *assembly, const sb_vec3 *u, sb_real dt);
/* Keeps the memory, and brings it back, for solves that end several steps before they may fail. */
SBI_API void sbi_assembly_save_memory(sbi_assembly *assembly);
SBI_API void sbi_assembly_restore_memory(sbi_assembly *assembly);
/* Until the next sbi_assembly_begin_step all respond at once and as if nothing had been remembered. */
SBI_API void sbi_assembly_drop_prestress(sbi_assembly *assembly);
/* The cells of one material (-1: all) forget: as if they had been at u for ever. */
SBI_API void sbi_assembly_forget(sbi_assembly *assembly, int material, const sb_vec3 *u);
/* One cell forgets. */
SBI_API void sbi_assembly_forget_cell(sbi_assembly *assembly, int cell, const sb_vec3 *u);
/* ---- assembly_turn ---- */

/* Mean deformation gradient of a cell with q points; the identity where it has no weight. */
SBI_API sb_mat3 sbi_assembly_mean_gradient(const sb_mat3 *f, const sb_real *weights, int q);

/* Gives a cell that is folded over at u one rotation for all its ordinary points; returns 1 then, else 0. f and
 * rotation: [points_per_cell] deformation gradients and what they turn by. */
SBI_API int sbi_assembly_fold_fallback(const sbi_assembly *assembly, int e, const sb_vec3 *u, const sb_mat3 *f,
                                       sb_quat *rotation);

/* Volume times the stress that all points of a cell with one rotation r, that of their mean gradient f, have besides
 * because the rotation turns with them: P : df is what a change df of f does to the cell's energy through r. moment:
 * the axial vector sum_ij e_ijk (w P F^T)_ij summed over the cell's points; stiffness: their w mu. Without it the
 * forces of a cell keep this moment and are the derivative of no energy. Fades where f is nearly inside out and where
 * moments are large. */
SBI_API sb_mat3 sbi_assembly_turning_stress(sb_mat3 r, sb_mat3 f, sb_vec3 moment, sb_real stiffness);

/* ---- assembly: readings ---- */

/* F and P at all points of a cell at u; f and p: [points_per_cell], mean points with their share of
 * the stress last. admissible[point] is 0 where the material does not admit F. */
SBI_API void sbi_assembly_points(const sbi_assembly *assembly, const sb_vec3 *u, int cell, sb_mat3 *f, sb_mat3 *p,
                                 int *admissible);
/* *energy (J) of one cell at u, its share of what sbi_assembly_energy sums; 0 with *energy untouched where the material
 * does not admit an F. */
SBI_API int sbi_assembly_cell_energy(const sbi_assembly *assembly, const sb_vec3 *u, int cell, sb_real *energy);

#endif /* SB_ASSEMBLY_H */
