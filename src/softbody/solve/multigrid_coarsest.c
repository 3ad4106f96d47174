/* multigrid_coarsest: the coarsest level, solved by elimination. Floor 1.
 *
 * Where no moduli jump it is as small as levels get, and a dense factor does. Where they do, a level of few nodes
 * cannot tell the regions' motions apart well enough, however often it is visited: then levels end at one of some
 * hundred nodes, with a sparse factor. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "multigrid_level.h"

/* ---- memory -------------------------------------------------------------------------------------------- */

/* The pattern that rows of a level have among themselves as a matrix; 0: no memory. */
static int sbi_mg_copy_level_pattern(const sbi_mg_level *level, const int *rows, int row_count, const int *place,
                                     const sb_allocator *allocator, sb_matrix *matrix)
{
    size_t most = 0, count = 0;
    int *pairs;
    sb_result result = SB_ERROR_MEMORY;
    for (int k = 0; k < row_count; k++) {
        int i = rows ? rows[k] : k;
        most += (size_t)(level->row_start[i + 1] - level->row_start[i]);
    }
    pairs = (int *)sbi_alloc(allocator, most, 2 * sizeof(int));
    for (int k = 0; pairs && k < row_count; k++) {
        int i = rows ? rows[k] : k;
        for (int q = level->row_start[i]; q < level->row_start[i + 1]; q++) {
            int other = place ? place[level->columns[q]] : level->columns[q];
            if (other < 0)
                continue;
            pairs[2 * count] = k;
            pairs[2 * count + 1] = other;
            count++;
        }
    }
    if (pairs)
        result = sb_matrix_create(row_count, (int)count, 2, NULL, pairs, allocator, matrix, NULL);
    sbi_free(allocator, pairs);
    return result == SB_OK;
}

SBI_API int sbi_mg_take_direct(sbi_multigrid *m, const sbi_mg_level *level, const int *rows, int row_count,
                               const int *place, sb_matrix *matrix, sb_direct **direct)
{
    if (!sbi_mg_copy_level_pattern(level, rows, row_count, place, &m->owned.allocator, matrix) ||
        sb_direct_create(NULL, matrix, &m->owned.allocator, direct, NULL) != SB_OK)
        return 0;
    m->owned.bytes += (size_t)matrix->block_count * (9 * sizeof(sb_real) + 2 * sizeof(int)) +
                      sb_direct_get_info(*direct).bytes +
                      (size_t)row_count * (2 * sizeof(int) + 1); /* row_start, diagonal, fixed */
    return 1;
}

SBI_API int sbi_mg_weigh_coarsest(sbi_multigrid *m, int *dear)
{
    const sbi_mg_level *level = m->levels + m->level_count - 1;
    size_t bytes = m->owned.bytes;
    double blocks = sbi_max_int(m->levels->row_start[m->levels->row_count], SBI_MG_DEAR_BLOCKS);
    *dear = 0;
    if (!m->regions.count || m->level_count == 1 || level->row_count > m->small)
        return 1;
    if (!sbi_mg_take_direct(m, level, NULL, level->row_count, NULL, &m->coarsest, &m->direct))
        return 0;
    *dear = level->row_count > SBI_MG_SPARSE / 2 &&
            sb_direct_get_info(m->direct).multiply_adds > (double)SBI_MG_DEAR * blocks;
    if (*dear) {
        sb_direct_free(m->direct);
        sb_matrix_free(&m->coarsest);
        m->direct = NULL;
        m->owned.bytes = bytes;
        m->small = SBI_MG_SPARSE / 2;
    }
    return 1;
}

static int sbi_mg_take_sparse(sbi_multigrid *m, const sbi_mg_level *level)
{
    m->exact = (sb_real *)sbi_owned_take(&m->owned, (size_t)level->row_count, 3 * sizeof(sb_real));
    if (!m->exact || m->direct)
        return m->exact != NULL;
    return sbi_mg_take_direct(m, level, NULL, level->row_count, NULL, &m->coarsest, &m->direct);
}

SBI_API int sbi_mg_take_coarsest(sbi_multigrid *m)
{
    const sbi_mg_level *level = m->levels + m->level_count - 1;
    size_t size = 3 * (size_t)level->row_count;
    if (m->level_count == 1 || level->row_count > 2 * m->small)
        return 1;
    if (m->regions.count)
        return sbi_mg_take_sparse(m, level);
    m->factor = (double *)sbi_owned_take(&m->owned, size, size * sizeof(double));
    m->pivot = (double *)sbi_owned_take(&m->owned, size, sizeof(double));
    m->solution = (double *)sbi_owned_take(&m->owned, size, sizeof(double));
    return m->factor && m->pivot && m->solution;
}

/* ---- dense --------------------------------------------------------------------------------------------- */

/* Cholesky factor R^T R in the upper triangle; directions without stiffness are left out. */
static void sbi_mg_factor_dense(sbi_multigrid *m, const sbi_mg_level *level)
{
    size_t n = 3 * (size_t)level->row_count;
    double *a = m->factor;
    memset(a, 0, n * n * sizeof(double));
    for (int i = 0; i < level->row_count; i++)
        for (int q = level->row_start[i]; q < level->row_start[i + 1]; q++)
            for (size_t k = 0; k < 9; k++)
                a[(3 * (size_t)i + k / 3) * n + 3 * (size_t)level->columns[q] + k % 3] =
                    (double)level->blocks[9 * (size_t)q + k];
    for (size_t k = 0; k < n; k++) /* single precision: what is smaller is rounding */
        m->solution[k] = 16 * (double)FLT_EPSILON * a[k * n + k];
    for (size_t k = 0; k < n; k++) {
        double *row = a + k * n, pivot = row[k];
        m->pivot[k] = pivot > 0 && pivot > m->solution[k] ? 1 / sqrt(pivot) : 0;
        for (size_t j = k; j < n; j++)
            row[j] *= m->pivot[k];
        for (size_t i = k + 1; i < n; i++) {
            double *other = a + i * n, factor = row[i];
            if (factor == 0)
                continue;
            for (size_t j = i; j < n; j++)
                other[j] -= factor * row[j];
        }
    }
}

/* solution = (R^T R)^-1 solution */
static void sbi_mg_solve_dense(sbi_multigrid *m, const sbi_mg_level *level)
{
    size_t n = 3 * (size_t)level->row_count;
    double *v = m->solution;
    for (size_t k = 0; k < n; k++) {
        const double *row = m->factor + k * n;
        double value = v[k] *= m->pivot[k];
        for (size_t j = k + 1; j < n; j++)
            v[j] -= value * row[j];
    }
    for (size_t k = n; k-- > 0;) {
        const double *row = m->factor + k * n;
        double sums[4] = {0, 0, 0, 0}, value = v[k];
        size_t j = k + 1;
        for (; j + 4 <= n; j += 4)
            for (size_t lane = 0; lane < 4; lane++)
                sums[lane] += row[j + lane] * v[j + lane];
        for (; j < n; j++)
            sums[0] += row[j] * v[j];
        value -= (sums[0] + sums[1]) + (sums[2] + sums[3]);
        v[k] = value * m->pivot[k];
    }
}

/* ---- sparse -------------------------------------------------------------------------------------------- */

/* The level's matrix with its diagonal times 1 + shift; 1 where there is no stiffness. */
static void sbi_mg_fill_coarsest(sbi_multigrid *m, const sbi_mg_level *level, double shift)
{
    sb_matrix *a = &m->coarsest;
    for (size_t q = 0; q < (size_t)level->block_count; q++)
        for (size_t k = 0; k < 9; k++)
            a->blocks[q][k] = (sb_real)level->blocks[9 * q + k];
    for (int i = 0; i < level->row_count; i++)
        for (int k = 0; k < 9; k += 4) {
            sb_real *entry = a->blocks[a->diagonal[i]] + k;
            *entry = *entry == 0 ? (sb_real)1 : (sb_real)((double)*entry * (1 + shift));
        }
}

/* The entries are of single precision, so that a direction without stiffness may look as if it had a negative one; the
 * shift makes up for that. By little, for it holds stiff parts where they are (16 units in the last place take half as
 * many iterations again as 1 at jumps of 1e5), but by several times the rounding: with 1 unit a pivot may be what is
 * left of nothing, and then what it divides is noise (27/49 iterations for 9/17, balls in 288,768 unknowns). Matrices
 * that are not positive definite need more, or get no factor. */
static int sbi_mg_factor_direct(sbi_multigrid *m, const sbi_mg_level *level)
{
    sb_result result = SB_ERROR_INDEFINITE;
    double shift = 4 * (double)FLT_EPSILON;
    for (int attempt = 0; attempt < 10 && result == SB_ERROR_INDEFINITE; attempt++) {
        sbi_mg_fill_coarsest(m, level, shift);
        result = sb_direct_update(m->direct, &m->coarsest, NULL);
        shift *= attempt < 4 ? 2 : 8;
    }
    return result == SB_OK;
}

/* ---- either -------------------------------------------------------------------------------------------- */

SBI_API int sbi_mg_factor_coarsest(sbi_multigrid *m)
{
    const sbi_mg_level *level = m->levels + m->level_count - 1;
    m->factored = m->factor != NULL;
    if (m->factor)
        sbi_mg_factor_dense(m, level);
    if (m->direct)
        m->factored = sbi_mg_factor_direct(m, level);
    return m->factored;
}

SBI_API void sbi_mg_solve_coarsest(sbi_multigrid *m)
{
    const sbi_mg_level *level = m->levels + m->level_count - 1;
    size_t n = 3 * (size_t)level->row_count;
    if (m->direct) {
        for (size_t k = 0; k < n; k++)
            m->exact[k] = (sb_real)level->r[4 * (k / 3) + k % 3];
        sb_direct_solve(m->direct, m->exact, m->exact, 1);
        for (size_t k = 0; k < n; k++)
            level->x[4 * (k / 3) + k % 3] = (float)m->exact[k];
        return;
    }
    for (size_t k = 0; k < n; k++)
        m->solution[k] = (double)level->r[4 * (k / 3) + k % 3];
    sbi_mg_solve_dense(m, level);
    for (size_t k = 0; k < n; k++)
        level->x[4 * (k / 3) + k % 3] = (float)m->solution[k];
}
