/* assembly_patch: the change of volume of patches of tet4, as part of what the cells hold. Floor 2, internal.
 *
 * With the share of a material that resists changes of volume, U(s) (J/m^3), s = J - 1, or what its model takes for it
 * (linear: tr e; corotated: tr(R^T F) - 3; SVK: tr E), a patch of cells with weights w_e has the mean
 *     s_P = sum w_e s_e / V,  V = sum w_e,   the energy  V U(s_P),   and with  b_a = sum w_e ds/dF_e g_a:
 *     f_a = U' b_a,   K_ab = U''/V b_a b_b^T + U' sum w_e g_a d2s/dF_e^2 g_b.
 * Cells add the last term with their own, which is that of their share of shear: linear, corotated and SVK ones with
 * the bulk modulus 0, isochoric ones and laws without their bulk term, neo-Hookean ones less their energy of F =
 * J^(1/3) I, so that W = U of such F, which patches have instead. A homogeneous state is that of elements without
 * patches. Cells of one stiffness factor each have the patch's mean of them. What a node has of its patches is summed
 * by nodes, the matrix by rows: one writer each, and the same bits for any number of threads. */
#ifndef SB_ASSEMBLY_PATCH_H
#define SB_ASSEMBLY_PATCH_H

#include "assembly.h"

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
struct sbi_patches {
    int count;
    int *cell_start, *cells;   /* [count + 1] into cells: those of each patch, ascending */
    int *corners;              /* by cell of `cells`: [4] places of its nodes in the patch's */
    int *node_start, *nodes;   /* [count + 1] into nodes: those of each patch, ascending. A place there is an entry */
    int *entry_start;          /* [node_count + 1] into entries: those of each node, by ascending patches */
    int *entries, *owners;     /* the entry and its patch */
    size_t *pair_start;        /* [count + 1] into pairs */
    int *pairs;                /* of each patch: matrix block of its nodes a, b */
    sb_vec3 *slopes;           /* by entry: b_a (m^2) */
    sb_real *pressure;         /* [count] U' (Pa) */
    sb_real *stiffness;        /* [count] U''/V (Pa/m^3) */
    sb_real *energy;           /* [count] (J) */
    sb_real *pull;             /* [count] what a force has of b_a (Pa) */
    unsigned char *admissible; /* [count] */
    void *lists, *memory;      /* the blocks behind the arrays: cells, starts of nodes; and the rest */
};

/* What points have of a material: no resistance to changes of volume at F = I. */
SBI_API sb_material sbi_patch_shear(const sb_material *material);
/* The lambda that points of a relaxed material have for the bulk modulus to stay. */
SBI_API sb_real sbi_patch_kept_lambda(const sb_material *whole, const sb_material *relaxed);
SBI_API sb_material sbi_patch_tangent_share(const sb_material *shear);
/* What a cell's points evaluate of a material, or its mean points: see sbi_material_share. Patches of cells have that
 * of changes of volume in this room's way, and find the whole material in its place. */
SBI_API sb_material sbi_assembly_share(const sb_domain *domain, const sb_material *material, int of_volume);
/* What points of the whole material have less than that share at F, as patches have it. */
SBI_API void sbi_patch_take_energy(const sb_material *whole, const sb_mat3 *f, sb_real *energy);
SBI_API void sbi_patch_take_stress(const sb_material *whole, const sb_mat3 *f, sb_mat3 *stress);

/* What patches of a domain need; NULL where it has none. SB_ERROR_MEMORY. */
SBI_API sb_result sbi_patches_create(const sb_domain *domain, const sb_allocator *allocator, sbi_patches **patches,
                                     sb_error *error);
SBI_API void sbi_patches_free(sbi_patches *patches, const sb_allocator *allocator); /* NULL is fine */
/* Where the patches' blocks are in a matrix that couples all nodes of each. */
SBI_API void sbi_patches_map(sbi_patches *patches, const sb_matrix *matrix);

/* Below, `assembly` has patches. Rotations of corotated cells start where the last force left them and stay there;
 * turned 1: they are those of u. Numbers of cells that are returned: -1, or the first of a patch whose change of volume
 * the material does not admit. */

/* The numbers of all patches at u; u NULL: those of SB_TANGENT_QUASI alone, of batched cells. */
SBI_API int sbi_patches_update(sbi_assembly *assembly, const sb_vec3 *u, int turned);
/* force += that of the patches at u, whose rotations are there. Also K x at them, x not NULL. */
SBI_API int sbi_patches_add_force(sbi_assembly *assembly, const sb_vec3 *u, const sb_vec3 *x, sb_vec3 *force);
/* The same of the patches of one material's cells only, with rotations of their own. */
SBI_API int sbi_patches_add_share(sbi_assembly *assembly, const sb_vec3 *u, int material, sb_vec3 *force);
/* y += K x, K the last sum's first term above, and x . K x; of batched cells at their rotations. */
SBI_API void sbi_patches_add_product(sbi_assembly *assembly, const sb_vec3 *x, sb_vec3 *y);
SBI_API sb_real sbi_patches_work(sbi_assembly *assembly, const sb_vec3 *x);
SBI_API int sbi_patches_energy(sbi_assembly *assembly, const sb_vec3 *u, sb_real *energy);
/* matrix += that term at the last update, times factor, or those of the cells' materials (NULL: none). */
SBI_API void sbi_patches_add_tangent(sbi_assembly *assembly, sb_tangent_kind kind, const sb_real *factors,
                                     sb_real factor, sb_matrix *matrix);
/* The same of what a row has above the diagonal, for the batched loops. */
SBI_API void sbi_patches_add_upper(sbi_assembly *assembly, const sb_real *factors, sb_real factor, int row,
                                   sb_matrix *matrix);
/* The exact tangent of what sbi_patch_tangent_share gives of a cell's share of shear, at F, becomes that of the whole
 * but for the term above, as of the last update, of the kind that is wanted; 0: not admissible. */
SBI_API int sbi_patches_finish_tangent(const sbi_assembly *assembly, int cell, const sb_mat3 *f, sb_quat rotation,
                                       sb_tangent_kind kind, sb_real *tangent);
/* *stress += the patch's in a cell at u; 0: not admissible. */
SBI_API int sbi_patches_cell_stress(const sbi_assembly *assembly, int cell, const sb_vec3 *u, sb_mat3 *stress);
/* *energy += the cell's share by volume. */
SBI_API int sbi_patches_cell_energy(const sbi_assembly *assembly, int cell, const sb_vec3 *u, sb_real *energy);
#endif

#endif /* SB_ASSEMBLY_PATCH_H */
