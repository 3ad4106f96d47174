/* assembly_glue: what ties two cells on copies of the same nodes, as part of what the cells hold. */
#include "assembly.h"

/* Jumps between the cells by node; those at a node that both have are 0. */
static void sbi_glue_jumps(int nodes, const sbi_glue_tie *tie, const sb_vec3 *u, sb_vec3 jumps[SBI_GLUE_NODES])
{
    for (int a = 0; a < nodes; a++)
        jumps[a] = sb_v3_sub(u[tie->nodes[0][a]], u[tie->nodes[1][a]]);
}

/* sum_b k G_ab d_b */
static sb_vec3 sbi_glue_pull(int nodes, const sbi_glue_tie *tie, int a, const sb_vec3 jumps[SBI_GLUE_NODES])
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int b = 0; b < nodes; b++)
        sum = sb_v3_madd(sum, tie->stiffness * tie->gram[sbi_glue_at(nodes, a, b)], jumps[b]);
    return sum;
}

SBI_API void sbi_glue_add_force(const sbi_glue *glue, const sb_vec3 *u, sb_vec3 *force)
{
    for (int k = 0; k < glue->count; k++) {
        const sbi_glue_tie *tie = glue->ties + k;
        sb_vec3 jumps[SBI_GLUE_NODES];
        sbi_glue_jumps(glue->nodes, tie, u, jumps);
        for (int a = 0; a < glue->nodes; a++) {
            sb_vec3 pull = sbi_glue_pull(glue->nodes, tie, a, jumps);
            if (tie->nodes[0][a] == tie->nodes[1][a])
                continue;
            force[tie->nodes[0][a]] = sb_v3_add(force[tie->nodes[0][a]], pull);
            force[tie->nodes[1][a]] = sb_v3_sub(force[tie->nodes[1][a]], pull);
        }
    }
}

SBI_API sb_real sbi_glue_energy(const sbi_glue *glue, const sb_vec3 *u)
{
    sb_real energy = 0;
    for (int k = 0; k < glue->count; k++) {
        sb_vec3 jumps[SBI_GLUE_NODES];
        sbi_glue_jumps(glue->nodes, glue->ties + k, u, jumps);
        for (int a = 0; a < glue->nodes; a++)
            energy += sb_v3_dot(jumps[a], sbi_glue_pull(glue->nodes, glue->ties + k, a, jumps)) / 2;
    }
    return energy;
}

SBI_API void sbi_glue_add_tangent(const sbi_glue *glue, sb_real factor, sb_matrix *matrix)
{
    int n = glue->nodes;
    for (int k = 0; k < glue->count; k++) {
        const sbi_glue_tie *tie = glue->ties + k;
        for (int i = 0; i < 4 * n * n; i++) {
            int a = i / 4 % n, b = i / 4 / n, side = i & 1, other = i >> 1 & 1;
            sb_real stiffness = factor * tie->stiffness * tie->gram[sbi_glue_at(n, a, b)], *block;
            if (tie->nodes[0][a] == tie->nodes[1][a] || tie->nodes[0][b] == tie->nodes[1][b])
                continue;
            block = matrix->blocks[sb_matrix_find(matrix, tie->nodes[side][a], tie->nodes[other][b])];
            stiffness = side == other ? stiffness : -stiffness;
            block[0] += stiffness;
            block[4] += stiffness;
            block[8] += stiffness;
        }
    }
}
