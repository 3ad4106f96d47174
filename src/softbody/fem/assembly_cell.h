/* assembly_cell: a cell's displacements and deformation gradients, for loops that know its numbers of nodes and points
 * as literals. Floor 2, internal. */
#ifndef SB_ASSEMBLY_CELL_H
#define SB_ASSEMBLY_CELL_H

#include "assembly.h"

SBI_FORCE_INLINE void sbi_cell_gather(const int *cell, const sb_vec3 *u, const int n, sb_real (*local)[3])
{
    for (int a = 0; a < n; a++) {
        local[a][0] = u[cell[a]].x;
        local[a][1] = u[cell[a]].y;
        local[a][2] = u[cell[a]].z;
    }
}

/* F = I + sum_a u_a g_a^T: displacements, not positions, so that rest is exact wherever the mesh lies. */
SBI_FORCE_INLINE sb_mat3 sbi_cell_deformation(const sb_real (*u)[3], const sb_real *gradients, const int n)
{
    sb_mat3 f = sb_m3_identity();
    for (int a = 0; a < n; a++)
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                f.m[i][j] += u[a][i] * gradients[3 * a + j];
    return f;
}

/* Deformation gradients of all points of a cell. */
SBI_FORCE_INLINE void sbi_cell_deformations(const sb_domain *domain, int e, const sb_vec3 *u, const int n, const int q,
                                            sb_mat3 *f)
{
    const sb_real *gradients = domain->gradients + (size_t)e * (size_t)q * 3 * (size_t)n;
    sb_real local[SB_MAX_ELEMENT_NODES][3];
    sbi_cell_gather(domain->cells + (size_t)e * (size_t)n, u, n, local);
    for (int p = 0; p < q; p++)
        f[p] = sbi_cell_deformation((const sb_real(*)[3])local, gradients + p * 3 * n, n);
}

#endif /* SB_ASSEMBLY_CELL_H */
