/* assembly_rows: springs between sums of nodes, as part of what the cells hold. */
#include "assembly.h"

/* sum_k w_k u_k of a row. */
static sb_vec3 sbi_rows_sum(const sbi_inner_rows *rows, int row, const sb_vec3 *u)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int k = rows->start[row]; k < rows->start[row + 1]; k++)
        sum = sb_v3_madd(sum, rows->weights[k], u[rows->nodes[k]]);
    return sum;
}

SBI_API void sbi_rows_add_force(const sbi_inner_rows *rows, const sb_vec3 *u, sb_vec3 *force)
{
    for (int row = 0; row < rows->count; row++) {
        sb_vec3 pull = sb_v3_scale(rows->stiffness[row], sbi_rows_sum(rows, row, u));
        for (int k = rows->start[row]; k < rows->start[row + 1]; k++)
            force[rows->nodes[k]] = sb_v3_madd(force[rows->nodes[k]], rows->weights[k], pull);
    }
}

SBI_API sb_real sbi_rows_energy(const sbi_inner_rows *rows, const sb_vec3 *u)
{
    sb_real energy = 0;
    for (int row = 0; row < rows->count; row++) {
        sb_vec3 sum = sbi_rows_sum(rows, row, u);
        energy += rows->stiffness[row] / 2 * sb_v3_dot(sum, sum);
    }
    return energy;
}

SBI_API void sbi_rows_add_tangent(const sbi_inner_rows *rows, sb_real factor, sb_matrix *matrix)
{
    for (int row = 0; row < rows->count; row++)
        for (int k = rows->start[row]; k < rows->start[row + 1]; k++)
            for (int j = rows->start[row]; j < rows->start[row + 1]; j++) {
                sb_real *block = matrix->blocks[sb_matrix_find(matrix, rows->nodes[k], rows->nodes[j])];
                sb_real stiffness = factor * rows->stiffness[row] * rows->weights[k] * rows->weights[j];
                block[0] += stiffness;
                block[4] += stiffness;
                block[8] += stiffness;
            }
}
