/* assembly_batch: corotated tet4 and tet10, SB_POLAR_LANES cells at a time. Floor 2, internal.
 *
 * Force: lane l of a batch is cell l; every loop over lanes is one compilers turn into vector instructions, and no lane
 * looks at another, so that vectors or not makes no difference to the bits.
 *
 * Tangent. With h_a = sqrt(w mu) R grad N_a at each point and S_ab = sum over points of h_a h_b^T,
 *     K_ab = sum over cells of (lambda / mu) S_ab + S_ab^T + tr(S_ab) I,
 * which is R C R^T (formula sheet, section 4). First the h of all cells are written; then each block above the diagonal
 * is summed over the cells of its edge and written once, by its row; then each row fetches the transposes below its
 * diagonal, and its diagonal block as what makes a translation cost nothing. Rows have one writer: no colours, no
 * clearing, and the same bits for any number of threads. */
#ifndef SB_ASSEMBLY_BATCH_H
#define SB_ASSEMBLY_BATCH_H

#include "assembly.h"

/* 1 when the batched loops can serve cells of this kind, if their materials are SB_COROTATED. */
SBI_API int sbi_batch_fits(const sb_domain *domain);
/* Takes the arrays of the batched loops from the arena and asks for what the processor has; for domains that fit. */
SBI_API void sbi_batch_layout(sbi_assembly *assembly, const sb_domain *domain, int block_count, sbi_arena *arena);
/* Copies the gradients into lanes. */
SBI_API void sbi_batch_fill(sbi_assembly *assembly);
/* A cell and two of its nodes in one number; tets take the bits of 16 nodes, whatever they have. */
enum { SBI_PAIR_NODE_BITS = 4 };
SBI_FORCE_INLINE int sbi_batch_node_bits(const int nodes)
{
    return nodes > 1 << SBI_PAIR_NODE_BITS ? 5 : SBI_PAIR_NODE_BITS;
}
SB_INLINE int sbi_batch_pair(int e, int a, int b, int bits) { return ((e << bits | a) << bits) | b; }
/* Lists for every block above the diagonal which cells and local pairs add to it, in cell order. */
SBI_API void sbi_batch_list_pairs(sbi_assembly *assembly, const sb_matrix *matrix);
/* Takes over the moduli of the cells' materials. */
SBI_API void sbi_batch_set_materials(sbi_assembly *assembly);
/* Gradients and moduli of one cell, or zeros of a free slot. */
SBI_API void sbi_batch_set_cell(sbi_assembly *assembly, int e);
/* The rotation of a tet4; setting it sets the saved one, too. */
SB_INLINE sb_quat sbi_batch_get_quat(const sbi_assembly *assembly, int e)
{
    const sb_real *at = assembly->batch_quats + (size_t)(e / SB_POLAR_LANES) * 4 * SB_POLAR_LANES + e % SB_POLAR_LANES;
    return sb_quat_make(at[0], at[SB_POLAR_LANES], at[2 * SB_POLAR_LANES], at[3 * SB_POLAR_LANES]);
}
SBI_API void sbi_batch_set_quat(sbi_assembly *assembly, int e, sb_quat quat);
/* Rotations become the identity; only where the batched loops keep their own. */
SBI_API void sbi_batch_reset_rotations(sbi_assembly *assembly);
/* The one of a cell, from that of a cell of another assembly. */
SBI_API void sbi_batch_copy_cell(sbi_assembly *to, int cell, const sbi_assembly *from, int old);
/* Saves the rotations that the batched loops keep of their own, or brings them back. */
SBI_API void sbi_batch_copy_rotations(sbi_assembly *assembly, int restore);

/* force += internal force of the cells begin <= e < end, begin a multiple of SB_POLAR_LANES; updates their
 * rotations. */
SBI_API void sbi_batch_force(sbi_assembly *assembly, const sb_vec3 *u, sb_vec3 *force, int begin, int end);
/* y += R C R^T x of these cells, with the rotations as they are. held not NULL: of those that are with cells of nodes
 * that it marks. */
SBI_API void sbi_batch_multiply(const sbi_assembly *assembly, const sb_vec3 *x, const unsigned char *held, sb_vec3 *y,
                                int begin, int end);
/* force += both, of these cells, which are tet4: that of u and R C R^T x, at the rotations of u. x NULL: that of u.
 * turned 1: the rotations are there already, and stay. */
SBI_API void sbi_batch_force_along(sbi_assembly *assembly, const sb_vec3 *u, const sb_vec3 *x, int turned,
                                   sb_vec3 *force, int begin, int end);
/* x . R C R^T x of these cells, which are tet4. */
SBI_API sb_real sbi_batch_work(const sbi_assembly *assembly, const sb_vec3 *x, int begin, int end);
/* Elastic energy at u of these cells, begin a multiple of SB_POLAR_LANES, each point with a rotation of its own; the
 * assembly's rotations stay. */
SBI_API sb_real sbi_batch_energy(const sbi_assembly *assembly, const sb_vec3 *u, int begin, int end);
/* matrix = factor R C R^T with the rotations as they are; each cell's C times that of its material, where there are
 * factors[material_count] (or NULL). */
SBI_API void sbi_batch_tangent(sbi_assembly *assembly, const sb_real *factors, sb_real factor, sb_matrix *matrix);

#endif /* SB_ASSEMBLY_BATCH_H */
