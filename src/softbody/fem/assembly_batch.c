/* assembly_batch: corotated tet4 and tet10, SB_POLAR_LANES cells at a time. */
#include "assembly_batch.h"
#include "assembly_live.h"
#include "assembly_patch.h"
#include "../base/lanes.h"

#include <string.h>

/* ---- set-up ---- */

SBI_API int sbi_batch_fits(const sb_domain *domain)
{
    int is_tet4 = domain->element_type == SB_TET4 && domain->points_per_cell == 1;
    int is_tet10 = domain->element_type == SB_TET10 && domain->points_per_cell == 4;
    int is_cloud = sbi_domain_is_cloud(domain);
    return (is_tet4 || is_tet10 || is_cloud) &&
           domain->cell_count < (INT32_MAX >> 2 * sbi_batch_node_bits(domain->nodes_per_cell)) - SB_POLAR_LANES;
}

/* Else tet10 or a cloud; known at compile time when SB_ELEMENT is set. */
static int sbi_batch_is_tet4(const sbi_assembly *assembly)
{
    return sbi_element_type_or_pinned(assembly->domain->element_type) == SB_TET4;
}
static int sbi_batch_is_cloud(const sbi_assembly *assembly)
{
    return SBI_ELEMENT_ENABLED(SB_CUSTOM) && assembly->domain->element_type == SB_CUSTOM;
}

static size_t sbi_batch_count(const sb_domain *domain)
{
    return ((size_t)domain->cell_count + SB_POLAR_LANES - 1) / SB_POLAR_LANES;
}

/* Reals that the tangent keeps of a cell: its rotated gradients. */
static size_t sbi_batch_rotated_size(const sb_domain *domain)
{
    return 3 * (size_t)domain->nodes_per_cell * (size_t)domain->points_per_cell;
}

SBI_API void sbi_batch_layout(sbi_assembly *assembly, const sb_domain *domain, int block_count, sbi_arena *arena)
{
    size_t cells = (size_t)sbi_max_int(domain->cell_capacity, domain->cell_count);
    size_t batches = (cells + SB_POLAR_LANES - 1) / SB_POLAR_LANES;
    size_t lane = SB_POLAR_LANES * sizeof(sb_real);
    size_t n = (size_t)domain->nodes_per_cell, q = (size_t)domain->points_per_cell;
    assembly->wide = sbi_lanes_are_wide();
    assembly->batch_gradients = (sb_real *)sbi_arena_take(arena, batches * q, 3 * (n - 1) * lane);
    assembly->batch_moduli = (sb_real *)sbi_arena_take(arena, batches * q, 3 * lane);
    if (q == 1) {
        assembly->batch_quats = (sb_real *)sbi_arena_take(arena, batches, 4 * lane);
        assembly->saved_batch_quats = (sb_real *)sbi_arena_take(arena, batches, 4 * lane);
    }
    assembly->rotated = (sb_real *)sbi_arena_take(arena, cells + 1, sbi_batch_rotated_size(domain) * sizeof(sb_real));
    assembly->ratios = (sb_real *)sbi_arena_take(arena, cells, sizeof(sb_real));
    if (sbi_domain_is_cloud(domain)) {
        assembly->node_stiffness = (sb_real *)sbi_arena_take(arena, (size_t)domain->node_count, sizeof(sb_real));
        assembly->node_diagonal = (sb_real *)sbi_arena_take(arena, (size_t)domain->node_count, sizeof(sb_real));
    }
    if (domain->cell_capacity)
        return; /* pairs are in rings */
    assembly->pair_start = (int *)sbi_arena_take(arena, (size_t)block_count + 1, sizeof(int));
    assembly->pairs = (int *)sbi_arena_take(arena, cells, n * (n - 1) / 2 * sizeof(int));
}

/* What stands in a lane: lanes beyond the last cell repeat it. */
static int sbi_batch_cell(const sb_domain *domain, int batch, int lane)
{
    return sbi_min_int(batch * SB_POLAR_LANES + lane, domain->cell_count - 1);
}

/* The gradients of a cell at a point into a lane. */
static void sbi_batch_fill_lane(sbi_assembly *assembly, int e, int batch, int p, int lane)
{
    const sb_domain *domain = assembly->domain;
    size_t n = (size_t)domain->nodes_per_cell, q = (size_t)domain->points_per_cell;
    size_t point = (size_t)e * q + (size_t)p, at = (size_t)batch * q + (size_t)p;
    sb_real *out = assembly->batch_gradients + at * 3 * (n - 1) * SB_POLAR_LANES + lane;
    for (size_t k = 3; k < 3 * n; k++, out += SB_POLAR_LANES)
        *out = domain->gradients[point * 3 * n + k];
}

SBI_API void sbi_batch_fill(sbi_assembly *assembly)
{
    const sb_domain *domain = assembly->domain;
    int batches = (int)sbi_batch_count(domain);
    for (int batch = 0; batch < batches; batch++)
        for (int p = 0; p < domain->points_per_cell; p++)
            for (int l = 0; l < SB_POLAR_LANES; l++)
                sbi_batch_fill_lane(assembly, sbi_batch_cell(domain, batch, l), batch, p, l);
}

/* 1 when the node is there for the width of the cells only: a cloud's last one, again. */
static int sbi_batch_is_repeated(const int *cell, int node) { return node > 0 && cell[node] == cell[node - 1]; }

SBI_API void sbi_batch_list_pairs(sbi_assembly *assembly, const sb_matrix *matrix)
{
    const sb_domain *domain = assembly->domain;
    int *start = assembly->pair_start, n = domain->nodes_per_cell, bits = sbi_batch_node_bits(n);
    memset(start, 0, ((size_t)matrix->block_count + 1) * sizeof *start);
    for (int pass = 0; pass < 2; pass++) {
        const int *block = assembly->scatter;
        for (int e = 0; e < domain->cell_count; e++) {
            const int *cell = domain->cells + (size_t)n * (size_t)e;
            for (int a = 0; a < n; a++)
                for (int b = a; b < n; b++, block++) {
                    int flip = cell[a] > cell[b], at = flip ? matrix->transpose[*block] : *block;
                    if (cell[a] == cell[b] || sbi_batch_is_repeated(cell, b)) /* the diagonal, a free slot's, no more */
                        continue;
                    if (pass == 0)
                        start[at]++;
                    else
                        assembly->pairs[start[at]++] =
                            flip ? sbi_batch_pair(e, b, a, bits) : sbi_batch_pair(e, a, b, bits);
                }
        }
        for (int i = 0, sum = 0; pass == 0 && i <= matrix->block_count; i++) {
            int count = start[i];
            start[i] = sum;
            sum += count;
        }
    }
    memmove(start + 1, start, (size_t)matrix->block_count * sizeof *start);
    start[0] = 0;
}

/* That of points, from which patches take the resistance to changes of volume. */
static sb_real sbi_batch_lambda(const sbi_assembly *assembly, const sb_material *material)
{
    return assembly->domain->cell_patch ? -2 * material->mu / 3 : material->lambda;
}

/* The moduli of a cell at a point into a lane. */
static void sbi_batch_set_moduli(sbi_assembly *assembly, int e, int batch, int p, int lane)
{
    int q = assembly->domain->points_per_cell;
    const sb_material *material = assembly->materials + assembly->cell_material[e];
    sb_real w = assembly->domain->weights[(size_t)e * (size_t)q + (size_t)p] * sbi_assembly_stiffness(assembly, e);
    sb_real *out = assembly->batch_moduli + ((size_t)batch * (size_t)q + (size_t)p) * 3 * SB_POLAR_LANES + lane;
    out[0] = w * sbi_batch_lambda(assembly, material);
    out[SB_POLAR_LANES] = w * material->mu;
    out[2 * SB_POLAR_LANES] = sb_sqrt(w * material->mu);
}

/* node_stiffness: of a point w (lambda + 4 mu) / 3 g.g, the mean of the diagonal of w ((lambda + mu) h h^T + mu h.h I)
 * with h = R g. */
static void sbi_batch_sum_diagonal(sbi_assembly *assembly)
{
    const sb_domain *domain = assembly->domain;
    size_t n = (size_t)domain->nodes_per_cell;
    memset(assembly->node_stiffness, 0, (size_t)domain->node_count * sizeof(sb_real));
    for (size_t e = 0; e < (size_t)domain->cell_count; e++) {
        const sb_material *material = assembly->materials + assembly->cell_material[e];
        sb_real w = domain->weights[e] * sbi_assembly_stiffness(assembly, (int)e);
        sb_real modulus = w * (material->lambda + 4 * material->mu) / 3;
        const sb_real *g = domain->gradients + 3 * n * e;
        for (size_t a = 0; a < n; a++, g += 3)
            assembly->node_stiffness[domain->cells[n * e + a]] += modulus * (g[0] * g[0] + g[1] * g[1] + g[2] * g[2]);
    }
}

static sb_real sbi_batch_ratio(const sbi_assembly *assembly, const sb_material *material)
{
    return sbi_batch_lambda(assembly, material) / material->mu;
}

SBI_API void sbi_batch_set_materials(sbi_assembly *assembly)
{
    const sb_domain *domain = assembly->domain;
    int batches = (int)sbi_batch_count(domain);
    for (int batch = 0; batch < batches; batch++)
        for (int p = 0; p < domain->points_per_cell; p++)
            for (int l = 0; l < SB_POLAR_LANES; l++)
                sbi_batch_set_moduli(assembly, sbi_batch_cell(domain, batch, l), batch, p, l);
    if (assembly->node_stiffness)
        sbi_batch_sum_diagonal(assembly);
    assembly->mixed = 0;
    for (int e = 0; e < domain->cell_count; e++) {
        assembly->ratios[e] = sbi_batch_ratio(assembly, assembly->materials + assembly->cell_material[e]);
        assembly->mixed |= assembly->ratios[e] < assembly->ratios[0] || assembly->ratios[e] > assembly->ratios[0];
    }
    /* where cells come and go the materials decide, whether a cell has them at present or not */
    for (int i = 0; assembly->live && i < assembly->material_count; i++) {
        sb_real ratio = sbi_batch_ratio(assembly, assembly->materials + i),
                first = sbi_batch_ratio(assembly, assembly->materials);
        assembly->mixed |= ratio < first || ratio > first;
    }
}

SBI_API void sbi_batch_set_cell(sbi_assembly *assembly, int e)
{
    int batch = e / SB_POLAR_LANES, lane = e % SB_POLAR_LANES;
    for (int p = 0; p < assembly->domain->points_per_cell; p++) {
        sbi_batch_fill_lane(assembly, e, batch, p, lane);
        sbi_batch_set_moduli(assembly, e, batch, p, lane);
    }
    assembly->ratios[e] = sbi_batch_ratio(assembly, assembly->materials + assembly->cell_material[e]);
}

SBI_API void sbi_batch_set_quat(sbi_assembly *assembly, int e, sb_quat quat)
{
    size_t at = (size_t)(e / SB_POLAR_LANES) * 4 * SB_POLAR_LANES + (size_t)(e % SB_POLAR_LANES);
    sb_real values[4];
    values[0] = quat.w, values[1] = quat.x, values[2] = quat.y, values[3] = quat.z;
    for (size_t k = 0; k < 4; k++)
        assembly->batch_quats[at + k * SB_POLAR_LANES] = assembly->saved_batch_quats[at + k * SB_POLAR_LANES] =
            values[k];
}

SBI_API void sbi_batch_reset_rotations(sbi_assembly *assembly)
{
    for (size_t i = 0; assembly->batch_quats && i < sbi_batch_count(assembly->domain) * 4 * SB_POLAR_LANES; i++)
        assembly->batch_quats[i] = (i / SB_POLAR_LANES) % 4 == 0 ? (sb_real)1 : (sb_real)0;
}

/* Where the four numbers of a cell's rotation stand, SB_POLAR_LANES apart. */
static sb_real *sbi_batch_quat_at(const sbi_assembly *assembly, int cell)
{
    return assembly->batch_quats + (size_t)(cell / SB_POLAR_LANES) * 4 * SB_POLAR_LANES + cell % SB_POLAR_LANES;
}

SBI_API void sbi_batch_copy_cell(sbi_assembly *to, int cell, const sbi_assembly *from, int old)
{
    for (int k = 0; to->batch_quats && from->batch_quats && k < 4 * SB_POLAR_LANES; k += SB_POLAR_LANES)
        sbi_batch_quat_at(to, cell)[k] = sbi_batch_quat_at(from, old)[k];
}

SBI_API void sbi_batch_copy_rotations(sbi_assembly *assembly, int restore)
{
    memcpy(restore ? assembly->batch_quats : assembly->saved_batch_quats,
           restore ? assembly->saved_batch_quats : assembly->batch_quats,
           sbi_batch_count(assembly->domain) * 4 * SB_POLAR_LANES * sizeof(sb_real));
}

/* ---- force ---- */

/* Nodes a >= 1 are taken three at a time below: there are three or nine of them, n being 4 or 10, so that none is left
 * over but of a cloud. Compilers do not unroll loops over them, and one at a time what is summed would be read and
 * written for each. */

SBI_FORCE_INLINE void sbi_batch_gather_node(sb_vec3 v, sb_vec3 origin, int l, sb_real (*d)[SB_POLAR_LANES])
{
    d[0][l] = v.x - origin.x;
    d[1][l] = v.y - origin.y;
    d[2][l] = v.z - origin.z;
}

/* Differences u_a - u_0 of nodes a >= 1 of the cells of a batch, component by component. */
SBI_FORCE_INLINE void sbi_batch_gather(const sb_domain *domain, int batch, const sb_vec3 *u, const int n,
                                       sb_real (*d)[SB_POLAR_LANES])
{
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        const int *cell = domain->cells + (size_t)n * (size_t)sbi_batch_cell(domain, batch, l);
        sb_vec3 origin = u[cell[0]];
        int a = 1;
        for (; a + 3 <= n; a += 3) {
            sbi_batch_gather_node(u[cell[a]], origin, l, d + 3 * (a - 1));
            sbi_batch_gather_node(u[cell[a + 1]], origin, l, d + 3 * a);
            sbi_batch_gather_node(u[cell[a + 2]], origin, l, d + 3 * (a + 1));
        }
        for (; a < n; a++)
            sbi_batch_gather_node(u[cell[a]], origin, l, d + 3 * (a - 1));
    }
}

/* Below, loops over lanes hold what can be done in a lane at once: compilers that do not unroll the loops about them
 * would otherwise read and write memory for each product. */

/* Row i of F = rest I + sum over nodes a >= 1 of (u_a - u_0) g_a^T. The first three need no F that was cleared. */
SBI_FORCE_INLINE void sbi_batch_deform_row(const sb_real (*SB_RESTRICT d)[SB_POLAR_LANES],
                                           const sb_real (*SB_RESTRICT g)[SB_POLAR_LANES], const int n, const int rest,
                                           const int i, sb_real (*SB_RESTRICT f)[SB_POLAR_LANES])
{
    const sb_real x = (sb_real)(i == 0 ? rest : 0), y = (sb_real)(i == 1 ? rest : 0), z = (sb_real)(i == 2 ? rest : 0);
    int a = n > 3 ? 3 : 0;
    for (int l = 0; l < SB_POLAR_LANES && n > 3; l++) {
        sb_real d0 = d[i][l], d1 = d[3 + i][l], d2 = d[6 + i][l];
        f[0][l] = x + d0 * g[0][l] + d1 * g[3][l] + d2 * g[6][l];
        f[1][l] = y + d0 * g[1][l] + d1 * g[4][l] + d2 * g[7][l];
        f[2][l] = z + d0 * g[2][l] + d1 * g[5][l] + d2 * g[8][l];
    }
    for (int l = 0; l < SB_POLAR_LANES && n <= 3; l++)
        f[0][l] = x, f[1][l] = y, f[2][l] = z;
    for (d += 3 * a, g += 3 * a; a + 3 <= n - 1; a += 3, d += 9, g += 9)
        for (int l = 0; l < SB_POLAR_LANES; l++) {
            sb_real d0 = d[i][l], d1 = d[3 + i][l], d2 = d[6 + i][l];
            f[0][l] = f[0][l] + d0 * g[0][l] + d1 * g[3][l] + d2 * g[6][l];
            f[1][l] = f[1][l] + d0 * g[1][l] + d1 * g[4][l] + d2 * g[7][l];
            f[2][l] = f[2][l] + d0 * g[2][l] + d1 * g[5][l] + d2 * g[8][l];
        }
    for (; a < n - 1; a++, d += 3, g += 3)
        for (int k = 0; k < 3; k++)
            for (int l = 0; l < SB_POLAR_LANES; l++)
                f[k][l] += d[i][l] * g[k][l];
}

/* F = rest I + sum over nodes a >= 1 of (u_a - u_0) g_a^T. */
SBI_FORCE_INLINE void sbi_batch_deformation(const sb_real (*SB_RESTRICT d)[SB_POLAR_LANES],
                                            const sb_real (*SB_RESTRICT g)[SB_POLAR_LANES], const int n, const int rest,
                                            sb_real (*SB_RESTRICT f)[SB_POLAR_LANES])
{
    for (int i = 0; i < 3; i++)
        sbi_batch_deform_row(d, g, n, rest, i, f + 3 * i);
}

/* Stress w P = 2 w mu (F - R) + w lambda (tr(R^T F) - 3) R, in place of F. */
SBI_FORCE_INLINE void sbi_batch_stress(const sb_real (*SB_RESTRICT r)[SB_POLAR_LANES],
                                       const sb_real *SB_RESTRICT lambda, const sb_real *SB_RESTRICT mu,
                                       sb_real (*SB_RESTRICT f)[SB_POLAR_LANES])
{
    sb_real twice[SB_POLAR_LANES], pressure[SB_POLAR_LANES];
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_real trace = -3;
        trace = trace + r[0][l] * f[0][l] + r[1][l] * f[1][l] + r[2][l] * f[2][l];
        trace = trace + r[3][l] * f[3][l] + r[4][l] * f[4][l] + r[5][l] * f[5][l];
        trace = trace + r[6][l] * f[6][l] + r[7][l] * f[7][l] + r[8][l] * f[8][l];
        twice[l] = 2 * mu[l];
        pressure[l] = lambda[l] * trace;
    }
    for (int k = 0; k < 9; k += 3)
        for (int l = 0; l < SB_POLAR_LANES; l++) {
            f[k][l] = twice[l] * (f[k][l] - r[k][l]) + pressure[l] * r[k][l];
            f[k + 1][l] = twice[l] * (f[k + 1][l] - r[k + 1][l]) + pressure[l] * r[k + 1][l];
            f[k + 2][l] = twice[l] * (f[k + 2][l] - r[k + 2][l]) + pressure[l] * r[k + 2][l];
        }
}

/* out[3 a + i] += sum_j m[3 i + j] g[3 a + j]: the 3x3 matrix m applied to the gradients of nodes a >= 1. */
SBI_FORCE_INLINE void sbi_batch_apply(const sb_real (*SB_RESTRICT m)[SB_POLAR_LANES],
                                      const sb_real (*SB_RESTRICT g)[SB_POLAR_LANES], const int n, const int add,
                                      sb_real (*SB_RESTRICT out)[SB_POLAR_LANES])
{
    for (int a = 0; a < n - 1; a++, g += 3, out += 3)
        for (int l = 0; l < SB_POLAR_LANES; l++) {
            sb_real g0 = g[0][l], g1 = g[1][l], g2 = g[2][l];
            sb_real x = m[0][l] * g0 + m[1][l] * g1 + m[2][l] * g2;
            sb_real y = m[3][l] * g0 + m[4][l] * g1 + m[5][l] * g2;
            sb_real z = m[6][l] * g0 + m[7][l] * g1 + m[8][l] * g2;
            out[0][l] = add ? out[0][l] + x : x;
            out[1][l] = add ? out[1][l] + y : y;
            out[2][l] = add ? out[2][l] + z : z;
        }
}

SBI_FORCE_INLINE void sbi_batch_scatter_node(const sb_real (*f)[SB_POLAR_LANES], int l, sb_vec3 *node, sb_vec3 *sum)
{
    sb_vec3 force = {f[0][l], f[1][l], f[2][l]};
    *sum = sb_v3_add(*sum, force);
    *node = sb_v3_add(*node, force);
}

/* Adds the forces of a batch to its nodes; node 0 has what makes their sum nothing. */
SBI_FORCE_INLINE void sbi_batch_scatter(const sb_domain *domain, int batch, const sb_real (*f)[SB_POLAR_LANES],
                                        const int n, sb_vec3 *force)
{
    int count = sbi_min_int(SB_POLAR_LANES, domain->cell_count - batch * SB_POLAR_LANES);
    for (int l = 0; l < count; l++) {
        const int *cell = domain->cells + (size_t)n * (size_t)(batch * SB_POLAR_LANES + l);
        sb_vec3 sum = {0, 0, 0};
        int a = 1;
        if (cell[0] == cell[1]) /* a free slot: node 0 may be at work on another thread */
            continue;
        for (; a + 3 <= n; a += 3) {
            sbi_batch_scatter_node(f + 3 * (a - 1), l, force + cell[a], &sum);
            sbi_batch_scatter_node(f + 3 * a, l, force + cell[a + 1], &sum);
            sbi_batch_scatter_node(f + 3 * (a + 1), l, force + cell[a + 2], &sum);
        }
        for (; a < n; a++)
            sbi_batch_scatter_node(f + 3 * (a - 1), l, force + cell[a], &sum);
        force[cell[0]] = sb_v3_sub(force[cell[0]], sum);
    }
}

/* Warm starts of a point of a batch into lanes, or back. */
SBI_FORCE_INLINE void sbi_batch_load_quats(const sbi_assembly *assembly, int batch, int p, const int q,
                                           sb_real (*quats)[SB_POLAR_LANES])
{
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        size_t e = (size_t)sbi_batch_cell(assembly->domain, batch, l);
        sb_quat at = assembly->rotations[e * (size_t)q + (size_t)p];
        quats[0][l] = at.w;
        quats[1][l] = at.x;
        quats[2][l] = at.y;
        quats[3][l] = at.z;
    }
}

SBI_FORCE_INLINE void sbi_batch_store_quats(sbi_assembly *assembly, int batch, int p, const int q,
                                            const sb_real (*quats)[SB_POLAR_LANES])
{
    int count = sbi_min_int(SB_POLAR_LANES, assembly->domain->cell_count - batch * SB_POLAR_LANES);
    for (int l = 0; l < count; l++) {
        size_t e = (size_t)(batch * SB_POLAR_LANES + l);
        assembly->rotations[e * (size_t)q + (size_t)p] =
            sb_quat_make(quats[0][l], quats[1][l], quats[2][l], quats[3][l]);
    }
}

typedef sb_real sbi_batch_rows[SB_POLAR_LANES];
#define SBI_BATCH_ROWS(pointer) ((const sb_real(*)[SB_POLAR_LANES])(pointer))

static sb_real *sbi_batch_gradients_at(const sbi_assembly *assembly, int batch, int p, const int n, const int q)
{
    size_t point = (size_t)batch * (size_t)q + (size_t)p;
    return assembly->batch_gradients + point * 3 * (size_t)(n - 1) * SB_POLAR_LANES;
}

static const sb_real *sbi_batch_moduli_at(const sbi_assembly *assembly, int batch, int p, const int q)
{
    return assembly->batch_moduli + ((size_t)batch * (size_t)q + (size_t)p) * 3 * SB_POLAR_LANES;
}

/* Smallest |cos| of half the angle between the rotations of two points of a tet10, over all cells of a batch. */
SBI_FORCE_INLINE sb_real sbi_batch_least_cos(const sb_real (*quats)[SB_POLAR_LANES])
{
    sbi_batch_rows square;
    sb_real least = 1;
    for (int l = 0; l < SB_POLAR_LANES; l++)
        square[l] = 1;
    for (int i = 4; i < 16; i += 4)
        for (int j = 0; j < i; j += 4)
            for (int l = 0; l < SB_POLAR_LANES; l++) {
                sb_real dot = quats[i][l] * quats[j][l] + quats[i + 1][l] * quats[j + 1][l] +
                              quats[i + 2][l] * quats[j + 2][l] + quats[i + 3][l] * quats[j + 3][l];
                square[l] = dot * dot < square[l] ? dot * dot : square[l];
            }
    for (int l = 0; l < SB_POLAR_LANES; l++)
        least = square[l] < least ? square[l] : least;
    return sb_sqrt(least);
}

/* R sym(R^T F): what corotated stress sees of F when R is not the rotation of F. */
SBI_FORCE_INLINE sb_mat3 sbi_batch_straighten(sb_mat3 r, sb_mat3 f)
{
    sb_mat3 b = sb_m3_tmul(r, f);
    return sb_m3_mul(r, sb_m3_scale((sb_real)0.5, sb_m3_add(b, sb_m3_transpose(b))));
}

/* The same for a point of a batch, in place of F. */
SBI_FORCE_INLINE void sbi_batch_straighten_point(const sb_real (*SB_RESTRICT r)[SB_POLAR_LANES],
                                                 sb_real (*SB_RESTRICT f)[SB_POLAR_LANES])
{
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_mat3 a, b;
        for (int k = 0; k < 9; k++) {
            a.m[k / 3][k % 3] = r[k][l];
            b.m[k / 3][k % 3] = f[k][l];
        }
        b = sbi_batch_straighten(a, b);
        for (int k = 0; k < 9; k++)
            f[k][l] = b.m[k / 3][k % 3];
    }
}

/* sb_polar_batch, which takes so much longer than a call that one copy serves all loops. */
SBI_FORCE_INLINE void sbi_batch_polar_lanes(const sbi_assembly *assembly, sb_real (*f)[SB_POLAR_LANES],
                                            sb_real (*q)[SB_POLAR_LANES], sb_real (*r)[SB_POLAR_LANES])
{
    (void)assembly; /* of which only `wide` matters */
    sbi_polar_batch(f, q, r);
}
SBI_WIDEN(sbi_batch_polar, assembly->wide,
          (const sbi_assembly *assembly, sb_real (*f)[SB_POLAR_LANES], sb_real (*q)[SB_POLAR_LANES],
           sb_real (*r)[SB_POLAR_LANES]),
          (assembly, f, q, r))

/* One rotation for the cells of a tet10 batch that are folded over, and F as sbi_batch_straighten leaves it. */
static void sbi_batch_fold_fallback(const sbi_assembly *assembly, int batch, const sb_vec3 *u,
                                    sb_real (*f)[SB_POLAR_LANES], sb_real (*quats)[SB_POLAR_LANES],
                                    sb_real (*r)[SB_POLAR_LANES])
{
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_mat3 gradient[4], shared;
        sb_quat rotation[4];
        for (int p = 0; p < 4; p++) {
            rotation[p] = sb_quat_make(quats[4 * p][l], quats[4 * p + 1][l], quats[4 * p + 2][l], quats[4 * p + 3][l]);
            for (int k = 0; k < 9; k++)
                gradient[p].m[k / 3][k % 3] = f[9 * p + k][l];
        }
        if (!sbi_assembly_fold_fallback(assembly, sbi_batch_cell(assembly->domain, batch, l), u, gradient, rotation))
            continue;
        shared = sb_quat_to_mat3(rotation[0]);
        for (int p = 0; p < 4; p++) {
            quats[4 * p][l] = rotation[p].w;
            quats[4 * p + 1][l] = rotation[p].x;
            quats[4 * p + 2][l] = rotation[p].y;
            quats[4 * p + 3][l] = rotation[p].z;
            gradient[p] = sbi_batch_straighten(shared, gradient[p]);
            for (int k = 0; k < 9; k++) {
                r[9 * p + k][l] = shared.m[k / 3][k % 3];
                f[9 * p + k][l] = gradient[p].m[k / 3][k % 3];
            }
        }
    }
}

/* Rotations r[9 p + k] and quats[4 p] of the points of a tet10 batch at u, where the gradients are f[9 p + k]; the
 * stress needs these as they are afterwards. */
SBI_FORCE_INLINE void sbi_batch_find_rotations(const sbi_assembly *assembly, int batch, const sb_vec3 *u,
                                               sb_real (*f)[SB_POLAR_LANES], sb_real (*quats)[SB_POLAR_LANES],
                                               sb_real (*r)[SB_POLAR_LANES])
{
    const sb_real may_be_twisted = (sb_real)0.51; /* sbi_assembly_fold_fallback decides, at 0.5 */
    for (int p = 0; p < 4; p++) {
        sbi_batch_load_quats(assembly, batch, p, 4, quats + 4 * p);
        sbi_batch_polar(assembly, f + 9 * p, quats + 4 * p, r + 9 * p);
    }
    if (assembly->fold_fallback && sbi_batch_least_cos(SBI_BATCH_ROWS(quats)) < may_be_twisted)
        sbi_batch_fold_fallback(assembly, batch, u, f, quats, r);
}

/* The same, which the assembly keeps. */
SBI_FORCE_INLINE void sbi_batch_rotate_points(sbi_assembly *assembly, int batch, const sb_vec3 *u,
                                              sb_real (*f)[SB_POLAR_LANES], sb_real (*r)[SB_POLAR_LANES])
{
    sbi_batch_rows quats[16];
    sbi_batch_find_rotations(assembly, batch, u, f, quats, r);
    for (int p = 0; p < 4; p++)
        sbi_batch_store_quats(assembly, batch, p, 4, SBI_BATCH_ROWS(quats + 4 * p));
}

/* sums[4] += moment and stiffness of one point with the stress w P, as sbi_assembly_turning_stress takes them. */
SBI_FORCE_INLINE void sbi_batch_add_moment(const sb_real *SB_RESTRICT mu,
                                           const sb_real (*SB_RESTRICT p)[SB_POLAR_LANES],
                                           const sb_real (*SB_RESTRICT f)[SB_POLAR_LANES],
                                           sb_real (*SB_RESTRICT sums)[SB_POLAR_LANES])
{
    for (int k = 0; k < 3; k++) {
        int i = 3 * ((k + 1) % 3), j = 3 * ((k + 2) % 3);
        for (int c = 0; c < 3; c++)
            for (int l = 0; l < SB_POLAR_LANES; l++)
                sums[k][l] += p[i + c][l] * f[j + c][l] - p[j + c][l] * f[i + c][l];
    }
    for (int l = 0; l < SB_POLAR_LANES; l++)
        sums[3][l] += mu[l];
}

/* Mean of the deformation gradients of a tet10 batch, by the points' w mu. */
SBI_FORCE_INLINE void sbi_batch_mean(const sbi_assembly *assembly, int batch, const sb_real (*f)[SB_POLAR_LANES],
                                     sb_real (*mean)[SB_POLAR_LANES])
{
    sbi_batch_rows sum;
    memset(sum, 0, sizeof sum);
    memset(mean, 0, 9 * sizeof mean[0]);
    for (int p = 0; p < 4; p++) {
        const sb_real *mu = sbi_batch_moduli_at(assembly, batch, p, 4) + SB_POLAR_LANES;
        for (int l = 0; l < SB_POLAR_LANES; l++)
            sum[l] += mu[l];
        for (int k = 0; k < 9; k++)
            for (int l = 0; l < SB_POLAR_LANES; l++)
                mean[k][l] += mu[l] * f[9 * p + k][l];
    }
    for (int k = 0; k < 9; k++)
        for (int l = 0; l < SB_POLAR_LANES; l++)
            mean[k][l] = sum[l] > 0 ? mean[k][l] / sum[l] : (sb_real)(k % 4 == 0);
}

/* sbi_assembly_turning_stress over w mu of the cell, in place of the mean gradient; 0 where that is 0. */
SBI_FORCE_INLINE void sbi_batch_turning_stress(const sb_real (*r)[SB_POLAR_LANES],
                                               const sb_real (*moment)[SB_POLAR_LANES], sb_real (*mean)[SB_POLAR_LANES])
{
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_mat3 turn, f, s;
        sb_real stiffness = moment[3][l];
        for (int k = 0; k < 9; k++) {
            turn.m[k / 3][k % 3] = r[k][l];
            f.m[k / 3][k % 3] = mean[k][l];
        }
        s = sbi_assembly_turning_stress(turn, f, sb_v3(moment[0][l], moment[1][l], moment[2][l]), stiffness);
        for (int k = 0; k < 9; k++)
            mean[k][l] = stiffness > 0 ? s.m[k / 3][k % 3] / stiffness : 0;
    }
}

/* Forces out[27] of a tet10 batch with one rotation per cell, that of its mean deformation gradient. */
SBI_FORCE_INLINE void sbi_batch_force_single(sbi_assembly *assembly, int batch, const sb_real (*f)[SB_POLAR_LANES],
                                             sb_real (*out)[SB_POLAR_LANES])
{
    sbi_batch_rows quats[4], mean[9], r[9], moment[4], stress[36];
    sbi_batch_mean(assembly, batch, f, mean);
    sbi_batch_load_quats(assembly, batch, 0, 4, quats);
    sbi_batch_polar(assembly, mean, quats, r);
    memset(moment, 0, sizeof moment);
    memcpy(stress, f, sizeof stress);
    for (int p = 0; p < 4; p++) {
        const sb_real *moduli = sbi_batch_moduli_at(assembly, batch, p, 4);
        sbi_batch_store_quats(assembly, batch, p, 4, SBI_BATCH_ROWS(quats));
        sbi_batch_straighten_point(SBI_BATCH_ROWS(r), stress + 9 * p);
        sbi_batch_stress(SBI_BATCH_ROWS(r), moduli, moduli + SB_POLAR_LANES, stress + 9 * p);
        sbi_batch_add_moment(moduli + SB_POLAR_LANES, SBI_BATCH_ROWS(stress + 9 * p), f + 9 * p, moment);
    }
    sbi_batch_turning_stress(SBI_BATCH_ROWS(r), SBI_BATCH_ROWS(moment), mean);
    memset(out, 0, 27 * sizeof out[0]);
    for (int p = 0; p < 4; p++) {
        const sb_real *mu = sbi_batch_moduli_at(assembly, batch, p, 4) + SB_POLAR_LANES;
        for (int k = 0; k < 9; k++)
            for (int l = 0; l < SB_POLAR_LANES; l++)
                stress[9 * p + k][l] += mu[l] * mean[k][l];
        sbi_batch_apply(SBI_BATCH_ROWS(stress + 9 * p),
                        SBI_BATCH_ROWS(sbi_batch_gradients_at(assembly, batch, p, 10, 4)), 10, 1, out);
    }
}

SBI_FORCE_INLINE void sbi_batch_force_tet10_lanes(int batch, sbi_assembly *assembly, const sb_vec3 *u, sb_vec3 *force)
{
    sbi_batch_rows d[27], f[36], r[36];
    sbi_batch_gather(assembly->domain, batch, u, 10, d);
    for (int p = 0; p < 4; p++)
        sbi_batch_deformation(SBI_BATCH_ROWS(d), SBI_BATCH_ROWS(sbi_batch_gradients_at(assembly, batch, p, 10, 4)), 10,
                              1, f + 9 * p);
    if (assembly->domain->single_rotation) {
        sbi_batch_force_single(assembly, batch, SBI_BATCH_ROWS(f), r);
        sbi_batch_scatter(assembly->domain, batch, SBI_BATCH_ROWS(r), 10, force);
        return;
    }
    sbi_batch_rotate_points(assembly, batch, u, f, r);
    memset(d, 0, sizeof d);
    for (int p = 0; p < 4; p++) {
        const sb_real *moduli = sbi_batch_moduli_at(assembly, batch, p, 4);
        sbi_batch_stress(SBI_BATCH_ROWS(r + 9 * p), moduli, moduli + SB_POLAR_LANES, f + 9 * p);
        sbi_batch_apply(SBI_BATCH_ROWS(f + 9 * p), SBI_BATCH_ROWS(sbi_batch_gradients_at(assembly, batch, p, 10, 4)),
                        10, 1, d);
    }
    sbi_batch_scatter(assembly->domain, batch, SBI_BATCH_ROWS(d), 10, force);
}
SBI_WIDEN(sbi_batch_force_tet10, assembly->wide, (int batch, sbi_assembly *assembly, const sb_vec3 *u, sb_vec3 *force),
          (batch, assembly, u, force))

/* Cells of one point; d: [3 (n - 1)] to work in. */
SBI_FORCE_INLINE void sbi_batch_force_point(sbi_assembly *assembly, const sb_vec3 *u, sb_vec3 *force, int batch,
                                            const int n, sb_real (*d)[SB_POLAR_LANES])
{
    sb_real *g = sbi_batch_gradients_at(assembly, batch, 0, n, 1);
    const sb_real *moduli = sbi_batch_moduli_at(assembly, batch, 0, 1);
    sbi_batch_rows f[9], r[9];
    sbi_batch_gather(assembly->domain, batch, u, n, d);
    sbi_batch_deformation(SBI_BATCH_ROWS(d), SBI_BATCH_ROWS(g), n, 1, f);
    sbi_batch_polar(assembly, f,
                    (sb_real(*)[SB_POLAR_LANES])(assembly->batch_quats + (size_t)batch * 4 * SB_POLAR_LANES), r);
    sbi_batch_stress(SBI_BATCH_ROWS(r), moduli, moduli + SB_POLAR_LANES, f);
    sbi_batch_apply(SBI_BATCH_ROWS(f), SBI_BATCH_ROWS(g), n, 0, d);
    sbi_batch_scatter(assembly->domain, batch, SBI_BATCH_ROWS(d), n, force);
}

SBI_FORCE_INLINE void sbi_batch_force_tet4_lanes(int batch, sbi_assembly *assembly, const sb_vec3 *u, sb_vec3 *force)
{
    sbi_batch_rows d[9];
    sbi_batch_force_point(assembly, u, force, batch, 4, d);
}
SBI_WIDEN(sbi_batch_force_tet4, assembly->wide, (int batch, sbi_assembly *assembly, const sb_vec3 *u, sb_vec3 *force),
          (batch, assembly, u, force))

SBI_FORCE_INLINE void sbi_batch_force_cloud_lanes(int batch, sbi_assembly *assembly, const sb_vec3 *u, sb_vec3 *force)
{
    sbi_batch_rows d[3 * (SB_MAX_ELEMENT_NODES - 1)];
    sbi_batch_force_point(assembly, u, force, batch, assembly->domain->nodes_per_cell, d);
}
SBI_WIDEN(sbi_batch_force_cloud, assembly->wide, (int batch, sbi_assembly *assembly, const sb_vec3 *u, sb_vec3 *force),
          (batch, assembly, u, force))

SBI_API void sbi_batch_force(sbi_assembly *assembly, const sb_vec3 *u, sb_vec3 *force, int begin, int end)
{
    for (int batch = begin / SB_POLAR_LANES; batch * SB_POLAR_LANES < end; batch++)
        if (sbi_batch_is_tet4(assembly))
            sbi_batch_force_tet4(batch, assembly, u, force);
        else if (sbi_batch_is_cloud(assembly))
            sbi_batch_force_cloud(batch, assembly, u, force);
        else
            sbi_batch_force_tet10(batch, assembly, u, force);
}

/* ---- product without a matrix ---- */

/* Rotation matrices of a point of a batch, as the last force left them. */
SBI_FORCE_INLINE void sbi_batch_rotations(const sbi_assembly *assembly, int batch, int p, const int q,
                                          sb_real (*SB_RESTRICT r)[SB_POLAR_LANES])
{
    sbi_batch_rows quats[4];
    if (q == 1)
        memcpy(quats, assembly->batch_quats + (size_t)batch * 4 * SB_POLAR_LANES, sizeof quats);
    else
        sbi_batch_load_quats(assembly, batch, p, q, quats);
    for (int l = 0; l < SB_POLAR_LANES; l++) { /* as sbi_quat_to_scaled_mat3 */
        sb_real w = quats[0][l], x = quats[1][l], y = quats[2][l], z = quats[3][l];
        sb_real sum = w * w + x * x, difference = w * w - x * x;
        r[0][l] = sum - (y * y + z * z);
        r[4][l] = difference + (y * y - z * z);
        r[8][l] = difference + (z * z - y * y);
    }
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_real w = quats[0][l], x = quats[1][l], y = quats[2][l], z = quats[3][l];
        sb_real xy = 2 * (x * y), wz = 2 * w * z, xz = 2 * (x * z), wy = 2 * w * y;
        r[1][l] = xy - wz;
        r[3][l] = xy + wz;
        r[2][l] = xz + wy;
        r[6][l] = xz - wy;
    }
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_real yz = 2 * (quats[2][l] * quats[3][l]), wx = 2 * quats[0][l] * quats[1][l];
        r[5][l] = yz - wx;
        r[7][l] = yz + wx;
    }
}

/* w R (lambda tr(e) I + 2 mu e), e = sym(R^T dF), in place of dF. */
SBI_FORCE_INLINE void sbi_batch_stress_change(const sb_real (*SB_RESTRICT r)[SB_POLAR_LANES],
                                              const sb_real *SB_RESTRICT lambda, const sb_real *SB_RESTRICT mu,
                                              sb_real (*SB_RESTRICT f)[SB_POLAR_LANES])
{
    sb_real b[9][SB_POLAR_LANES], volume[SB_POLAR_LANES];
    for (int j = 0; j < 3; j++) /* R^T dF */
        for (int l = 0; l < SB_POLAR_LANES; l++) {
            sb_real f0 = f[j][l], f1 = f[3 + j][l], f2 = f[6 + j][l];
            b[j][l] = r[0][l] * f0 + r[3][l] * f1 + r[6][l] * f2;
            b[3 + j][l] = r[1][l] * f0 + r[4][l] * f1 + r[7][l] * f2;
            b[6 + j][l] = r[2][l] * f0 + r[5][l] * f1 + r[8][l] * f2;
        }
    for (int l = 0; l < SB_POLAR_LANES; l++)
        volume[l] = lambda[l] * (b[0][l] + b[4][l] + b[8][l]);
    for (int k = 0; k < 9; k += 4)
        for (int l = 0; l < SB_POLAR_LANES; l++)
            b[k][l] = mu[l] * (b[k][l] + b[k][l]) + volume[l];
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        b[1][l] = b[3][l] = mu[l] * (b[1][l] + b[3][l]);
        b[2][l] = b[6][l] = mu[l] * (b[2][l] + b[6][l]);
        b[5][l] = b[7][l] = mu[l] * (b[5][l] + b[7][l]);
    }
    for (int i = 0; i < 9; i += 3)
        for (int l = 0; l < SB_POLAR_LANES; l++) {
            sb_real r0 = r[i][l], r1 = r[i + 1][l], r2 = r[i + 2][l];
            f[i][l] = r0 * b[0][l] + r1 * b[3][l] + r2 * b[6][l];
            f[i + 1][l] = r0 * b[1][l] + r1 * b[4][l] + r2 * b[7][l];
            f[i + 2][l] = r0 * b[2][l] + r1 * b[5][l] + r2 * b[8][l];
        }
}

/* d, sum: [3 (n - 1)] to work in. */
SBI_FORCE_INLINE void sbi_batch_multiply_cells(const sbi_assembly *assembly, const sb_vec3 *x, sb_vec3 *y, int batch,
                                               const int n, const int q, sb_real (*d)[SB_POLAR_LANES],
                                               sb_real (*sum)[SB_POLAR_LANES])
{
    sbi_batch_rows f[9], r[9];
    sbi_batch_gather(assembly->domain, batch, x, n, d);
    if (q > 1)
        memset(sum, 0, 3 * (size_t)(n - 1) * sizeof sum[0]);
    for (int p = 0; p < q; p++) {
        const sb_real *moduli = sbi_batch_moduli_at(assembly, batch, p, q);
        sb_real *g = sbi_batch_gradients_at(assembly, batch, p, n, q);
        sbi_batch_rotations(assembly, batch, p, q, r);
        sbi_batch_deformation(SBI_BATCH_ROWS(d), SBI_BATCH_ROWS(g), n, 0, f);
        sbi_batch_stress_change(SBI_BATCH_ROWS(r), moduli, moduli + SB_POLAR_LANES, f);
        sbi_batch_apply(SBI_BATCH_ROWS(f), SBI_BATCH_ROWS(g), n, q > 1, sum);
    }
    sbi_batch_scatter(assembly->domain, batch, SBI_BATCH_ROWS(sum), n, y);
}

SBI_FORCE_INLINE void sbi_batch_multiply_tets_lanes(int batch, const sbi_assembly *assembly, const sb_vec3 *x,
                                                    sb_vec3 *y)
{
    sbi_batch_rows d[27], sum[27];
    if (sbi_batch_is_tet4(assembly))
        sbi_batch_multiply_cells(assembly, x, y, batch, 4, 1, d, sum);
    else
        sbi_batch_multiply_cells(assembly, x, y, batch, 10, 4, d, sum);
}
SBI_WIDEN(sbi_batch_multiply_tets, assembly->wide,
          (int batch, const sbi_assembly *assembly, const sb_vec3 *x, sb_vec3 *y), (batch, assembly, x, y))

SBI_FORCE_INLINE void sbi_batch_multiply_clouds_lanes(int batch, const sbi_assembly *assembly, const sb_vec3 *x,
                                                      sb_vec3 *y)
{
    sbi_batch_rows d[3 * (SB_MAX_ELEMENT_NODES - 1)], sum[3 * (SB_MAX_ELEMENT_NODES - 1)];
    sbi_batch_multiply_cells(assembly, x, y, batch, assembly->domain->nodes_per_cell, 1, d, sum);
}
SBI_WIDEN(sbi_batch_multiply_clouds, assembly->wide,
          (int batch, const sbi_assembly *assembly, const sb_vec3 *x, sb_vec3 *y), (batch, assembly, x, y))

/* 1: cells of a batch have nodes that are marked. */
static int sbi_batch_has_marked(const sb_domain *domain, int batch, const unsigned char *marks)
{
    size_t n = (size_t)domain->nodes_per_cell, first = (size_t)batch * SB_POLAR_LANES;
    const int *node = domain->cells + first * n;
    const int *end = node + (size_t)sbi_min_int(SB_POLAR_LANES, domain->cell_count - (int)first) * n;
    for (; node < end; node++)
        if (marks[*node])
            return 1;
    return 0;
}

SBI_API void sbi_batch_multiply(const sbi_assembly *assembly, const sb_vec3 *x, const unsigned char *held, sb_vec3 *y,
                                int begin, int end)
{
    for (int batch = begin / SB_POLAR_LANES; batch * SB_POLAR_LANES < end; batch++)
        if (held && !sbi_batch_has_marked(assembly->domain, batch, held))
            continue;
        else if (sbi_batch_is_cloud(assembly))
            sbi_batch_multiply_clouds(batch, assembly, x, y);
        else
            sbi_batch_multiply_tets(batch, assembly, x, y);
}

/* ---- force and product at once ---- */

/* f + dF - R in place of f: with R^T F - I symmetric, w R (lambda tr(e) I + 2 mu e), e = sym(R^T (F + dF - R)), is the
 * stress of F and what dF changes it by at this R. */
SBI_FORCE_INLINE void sbi_batch_add_change(const sb_real (*SB_RESTRICT r)[SB_POLAR_LANES],
                                           const sb_real (*SB_RESTRICT change)[SB_POLAR_LANES],
                                           sb_real (*SB_RESTRICT f)[SB_POLAR_LANES])
{
    for (int k = 0; k < 9; k++)
        for (int l = 0; l < SB_POLAR_LANES; l++)
            f[k][l] = f[k][l] - r[k][l] + change[k][l];
}

/* Of tet4: what both need of a cell is read once, and their stresses are one before they become forces. */
SBI_FORCE_INLINE void sbi_batch_force_along_tet4_lanes(int batch, sbi_assembly *assembly, const sb_vec3 *u,
                                                       const sb_vec3 *x, int turned, sb_vec3 *force)
{
    sb_real *g = sbi_batch_gradients_at(assembly, batch, 0, 4, 1);
    sb_real *quats = assembly->batch_quats + (size_t)batch * 4 * SB_POLAR_LANES;
    const sb_real *moduli = sbi_batch_moduli_at(assembly, batch, 0, 1);
    sbi_batch_rows d[9], f[9], change[9], r[9];
    sbi_batch_gather(assembly->domain, batch, u, 4, d);
    sbi_batch_deformation(SBI_BATCH_ROWS(d), SBI_BATCH_ROWS(g), 4, 1, f);
    if (turned)
        sbi_batch_rotations(assembly, batch, 0, 1, r);
    else
        sbi_batch_polar(assembly, f, (sb_real(*)[SB_POLAR_LANES])quats, r);
    if (x) {
        sbi_batch_gather(assembly->domain, batch, x, 4, d);
        sbi_batch_deformation(SBI_BATCH_ROWS(d), SBI_BATCH_ROWS(g), 4, 0, change);
        sbi_batch_add_change(SBI_BATCH_ROWS(r), SBI_BATCH_ROWS(change), f);
        sbi_batch_stress_change(SBI_BATCH_ROWS(r), moduli, moduli + SB_POLAR_LANES, f);
    } else {
        sbi_batch_stress(SBI_BATCH_ROWS(r), moduli, moduli + SB_POLAR_LANES, f);
    }
    sbi_batch_apply(SBI_BATCH_ROWS(f), SBI_BATCH_ROWS(g), 4, 0, d);
    sbi_batch_scatter(assembly->domain, batch, SBI_BATCH_ROWS(d), 4, force);
}
SBI_WIDEN(sbi_batch_force_along_tet4, assembly->wide,
          (int batch, sbi_assembly *assembly, const sb_vec3 *u, const sb_vec3 *x, int turned, sb_vec3 *force),
          (batch, assembly, u, x, turned, force))

SBI_API void sbi_batch_force_along(sbi_assembly *assembly, const sb_vec3 *u, const sb_vec3 *x, int turned,
                                   sb_vec3 *force, int begin, int end)
{
    for (int batch = begin / SB_POLAR_LANES; batch * SB_POLAR_LANES < end; batch++)
        sbi_batch_force_along_tet4(batch, assembly, u, x, turned, force);
}

/* ---- work without a matrix ---- */

/* work = dF : C dF of each lane, C that of sbi_batch_stress_change: with e = sym(R^T dF), lambda tr(e)^2 + 2 mu e : e.
 */
SBI_FORCE_INLINE void sbi_batch_work_change(const sb_real (*SB_RESTRICT r)[SB_POLAR_LANES],
                                            const sb_real *SB_RESTRICT lambda, const sb_real *SB_RESTRICT mu,
                                            const sb_real (*SB_RESTRICT f)[SB_POLAR_LANES], sb_real *SB_RESTRICT work)
{
    sb_real b[9][SB_POLAR_LANES];
    for (int j = 0; j < 3; j++) /* R^T dF */
        for (int l = 0; l < SB_POLAR_LANES; l++) {
            sb_real f0 = f[j][l], f1 = f[3 + j][l], f2 = f[6 + j][l];
            b[j][l] = r[0][l] * f0 + r[3][l] * f1 + r[6][l] * f2;
            b[3 + j][l] = r[1][l] * f0 + r[4][l] * f1 + r[7][l] * f2;
            b[6 + j][l] = r[2][l] * f0 + r[5][l] * f1 + r[8][l] * f2;
        }
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_real xy = b[1][l] + b[3][l], xz = b[2][l] + b[6][l], yz = b[5][l] + b[7][l];
        work[l] = xy * xy + xz * xz + yz * yz;
    }
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_real xx = b[0][l], yy = b[4][l], zz = b[8][l], trace = xx + yy + zz;
        work[l] = lambda[l] * (trace * trace) + mu[l] * (2 * (xx * xx + yy * yy + zz * zz) + work[l]);
    }
}

/* Of the cells of a batch: lanes beyond the last cell repeat it. */
SBI_FORCE_INLINE void sbi_batch_work_tet4_lanes(int batch, const sbi_assembly *assembly, const sb_vec3 *x,
                                                sb_real *work)
{
    const sb_real *moduli = sbi_batch_moduli_at(assembly, batch, 0, 1);
    sb_real *g = sbi_batch_gradients_at(assembly, batch, 0, 4, 1);
    sbi_batch_rows d[9], f[9], r[9];
    sbi_batch_gather(assembly->domain, batch, x, 4, d);
    sbi_batch_rotations(assembly, batch, 0, 1, r);
    sbi_batch_deformation(SBI_BATCH_ROWS(d), SBI_BATCH_ROWS(g), 4, 0, f);
    sbi_batch_work_change(SBI_BATCH_ROWS(r), moduli, moduli + SB_POLAR_LANES, SBI_BATCH_ROWS(f), work);
}
SBI_WIDEN(sbi_batch_work_tet4, assembly->wide,
          (int batch, const sbi_assembly *assembly, const sb_vec3 *x, sb_real *work), (batch, assembly, x, work))

SBI_API sb_real sbi_batch_work(const sbi_assembly *assembly, const sb_vec3 *x, int begin, int end)
{
    sb_real sum = 0, work[SB_POLAR_LANES];
    for (int first = begin; first < end; first += SB_POLAR_LANES) {
        int count = sbi_min_int(SB_POLAR_LANES, end - first);
        sbi_batch_work_tet4(first / SB_POLAR_LANES, assembly, x, work);
        for (int l = 0; l < count; l++)
            sum += sbi_domain_is_free(assembly->domain, first + l) ? 0 : work[l];
    }
    return sum;
}

/* ---- energy ---- */

/* energy += that of a point. With R^T F symmetric, F - R is what sbi_batch_work_change has twice the energy of F of. */
SBI_FORCE_INLINE void sbi_batch_add_energy(const sbi_assembly *assembly, int batch, int p, const int q,
                                           const sb_real (*SB_RESTRICT r)[SB_POLAR_LANES],
                                           sb_real (*SB_RESTRICT f)[SB_POLAR_LANES], sb_real *SB_RESTRICT energy)
{
    const sb_real *moduli = sbi_batch_moduli_at(assembly, batch, p, q);
    sb_real work[SB_POLAR_LANES];
    for (int k = 0; k < 9; k++)
        for (int l = 0; l < SB_POLAR_LANES; l++)
            f[k][l] -= r[k][l];
    sbi_batch_work_change(r, moduli, moduli + SB_POLAR_LANES, SBI_BATCH_ROWS(f), work);
    for (int l = 0; l < SB_POLAR_LANES; l++)
        energy[l] += work[l] / 2;
}

/* Of the cells of a batch, which have one point; d: [3 (n - 1)] to work in. Rotations start where the last force left
 * them, and stay there. */
SBI_FORCE_INLINE void sbi_batch_energy_point(const sbi_assembly *assembly, const sb_vec3 *u, int batch, const int n,
                                             sb_real (*d)[SB_POLAR_LANES], sb_real *energy)
{
    sbi_batch_rows f[9], r[9], quats[4];
    sbi_batch_gather(assembly->domain, batch, u, n, d);
    sbi_batch_deformation(SBI_BATCH_ROWS(d), SBI_BATCH_ROWS(sbi_batch_gradients_at(assembly, batch, 0, n, 1)), n, 1, f);
    memcpy(quats, assembly->batch_quats + (size_t)batch * 4 * SB_POLAR_LANES, sizeof quats);
    sbi_batch_polar(assembly, f, quats, r);
    sbi_batch_add_energy(assembly, batch, 0, 1, SBI_BATCH_ROWS(r), f, energy);
}

/* The same of tet10. */
SBI_FORCE_INLINE void sbi_batch_energy_tet10(const sbi_assembly *assembly, const sb_vec3 *u, int batch, sb_real *energy)
{
    sbi_batch_rows d[27], f[36], r[36], quats[16];
    sbi_batch_gather(assembly->domain, batch, u, 10, d);
    for (int p = 0; p < 4; p++)
        sbi_batch_deformation(SBI_BATCH_ROWS(d), SBI_BATCH_ROWS(sbi_batch_gradients_at(assembly, batch, p, 10, 4)), 10,
                              1, f + 9 * p);
    sbi_batch_find_rotations(assembly, batch, u, f, quats, r);
    for (int p = 0; p < 4; p++)
        sbi_batch_add_energy(assembly, batch, p, 4, SBI_BATCH_ROWS(r + 9 * p), f + 9 * p, energy);
}

SBI_FORCE_INLINE void sbi_batch_energies_lanes(int batch, const sbi_assembly *assembly, const sb_vec3 *u,
                                               sb_real *energy)
{
    sbi_batch_rows d[3 * (SB_MAX_ELEMENT_NODES - 1)];
    memset(energy, 0, SB_POLAR_LANES * sizeof energy[0]);
    if (sbi_batch_is_tet4(assembly))
        sbi_batch_energy_point(assembly, u, batch, 4, d, energy);
    else if (sbi_batch_is_cloud(assembly))
        sbi_batch_energy_point(assembly, u, batch, assembly->domain->nodes_per_cell, d, energy);
    else
        sbi_batch_energy_tet10(assembly, u, batch, energy);
}
SBI_WIDEN(sbi_batch_energies, assembly->wide,
          (int batch, const sbi_assembly *assembly, const sb_vec3 *u, sb_real *energy), (batch, assembly, u, energy))

SBI_API sb_real sbi_batch_energy(const sbi_assembly *assembly, const sb_vec3 *u, int begin, int end)
{
    sb_real sum = 0, energy[SB_POLAR_LANES];
    for (int first = begin; first < end; first += SB_POLAR_LANES) {
        int count = sbi_min_int(SB_POLAR_LANES, end - first);
        sbi_batch_energies(first / SB_POLAR_LANES, assembly, u, energy);
        for (int l = 0; l < count; l++) /* lanes beyond the last cell repeat it */
            sum += sbi_domain_is_free(assembly->domain, first + l) ? 0 : energy[l];
    }
    return sum;
}

/* ---- tangent: rotated gradients ---- */

/* Rotations times the roots of their cells' factors. */
static void sbi_batch_weight(const sbi_assembly *assembly, const sb_real *factors, int batch,
                             sb_real (*r)[SB_POLAR_LANES])
{
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_real root = sb_sqrt(factors[assembly->cell_material[sbi_batch_cell(assembly->domain, batch, l)]]);
        for (int k = 0; k < 9; k++)
            r[k][l] *= root;
    }
}

/* h[3 (q a + p) + i] = component i of sqrt(w mu) R g_a at point p of a batch, for all nodes a; factors or NULL. */
SBI_FORCE_INLINE void sbi_batch_rotate_gradients(const sbi_assembly *assembly, const sb_real *factors, int batch, int p,
                                                 const int n, const int q, sb_real (*SB_RESTRICT h)[SB_POLAR_LANES])
{
    const sb_real(*g)[SB_POLAR_LANES] = SBI_BATCH_ROWS(sbi_batch_gradients_at(assembly, batch, p, n, q));
    const sb_real *scale = sbi_batch_moduli_at(assembly, batch, p, q) + 2 * SB_POLAR_LANES;
    sbi_batch_rows r[9], sum[3];
    sbi_batch_rotations(assembly, batch, p, q, r);
    for (int k = 0; k < 9; k++)
        for (int l = 0; l < SB_POLAR_LANES; l++)
            r[k][l] *= scale[l];
    if (factors)
        sbi_batch_weight(assembly, factors, batch, r);
    memset(sum, 0, sizeof sum);
    for (int a = 1; a < n; a++, g += 3) {
        sb_real(*to)[SB_POLAR_LANES] = h + 3 * (q * a + p);
        for (int l = 0; l < SB_POLAR_LANES; l++) {
            sb_real g0 = g[0][l], g1 = g[1][l], g2 = g[2][l];
            sb_real x = r[0][l] * g0 + r[1][l] * g1 + r[2][l] * g2;
            sb_real y = r[3][l] * g0 + r[4][l] * g1 + r[5][l] * g2;
            sb_real z = r[6][l] * g0 + r[7][l] * g1 + r[8][l] * g2;
            to[0][l] = x, to[1][l] = y, to[2][l] = z;
            sum[0][l] -= x, sum[1][l] -= y, sum[2][l] -= z;
        }
    }
    memcpy(h + 3 * p, sum, sizeof sum);
}

/* What a lane has in each of the rows. */
SBI_FORCE_INLINE void sbi_batch_copy_lane(const sb_real (*rows)[SB_POLAR_LANES], int l, const int count, sb_real *out)
{
    int k = 0;
    for (; k + 4 <= count; k += 4) {
        out[k] = rows[k][l], out[k + 1] = rows[k + 1][l];
        out[k + 2] = rows[k + 2][l], out[k + 3] = rows[k + 3][l];
    }
    for (; k < count; k++)
        out[k] = rows[k][l];
}

/* The rotated gradients of the cells of a batch. */
SBI_FORCE_INLINE void sbi_batch_rotate(const sbi_assembly *assembly, const sb_real *factors, int batch, const int n,
                                       const int q)
{
    const int size = 3 * n * q;
    int count = sbi_min_int(SB_POLAR_LANES, assembly->domain->cell_count - batch * SB_POLAR_LANES);
    sb_real *out = assembly->rotated + (size_t)batch * SB_POLAR_LANES * (size_t)size;
    sbi_batch_rows h[120];
    for (int p = 0; p < q; p++)
        sbi_batch_rotate_gradients(assembly, factors, batch, p, n, q, h);
    for (int l = 0; l < count; l++, out += size)
        sbi_batch_copy_lane(SBI_BATCH_ROWS(h), l, size, out);
}

typedef struct sbi_batch_job {
    sbi_assembly *assembly;
    sb_matrix *matrix;
    const sb_real *factors; /* [material_count], or NULL */
    sb_real factor;
} sbi_batch_job;

SBI_FORCE_INLINE void sbi_batch_rotate_cells_lanes(int batch, const sbi_assembly *assembly, const sb_real *factors)
{
    if (sbi_batch_is_tet4(assembly))
        sbi_batch_rotate(assembly, factors, batch, 4, 1);
    else if (sbi_batch_is_cloud(assembly))
        sbi_batch_rotate(assembly, factors, batch, assembly->domain->nodes_per_cell, 1);
    else
        sbi_batch_rotate(assembly, factors, batch, 10, 4);
}
SBI_WIDEN(sbi_batch_rotate_cells, assembly->wide, (int batch, const sbi_assembly *assembly, const sb_real *factors),
          (batch, assembly, factors))

static void sbi_batch_rotate_chunk(void *user, int chunk)
{
    const sb_real *factors = ((const sbi_batch_job *)user)->factors;
    sbi_assembly *assembly = ((const sbi_batch_job *)user)->assembly;
    int batch = chunk * (assembly->chunk_size / SB_POLAR_LANES);
    int end = sbi_min_int(batch + assembly->chunk_size / SB_POLAR_LANES, (int)sbi_batch_count(assembly->domain));
    for (; batch < end; batch++)
        sbi_batch_rotate_cells(batch, assembly, factors);
}

/* ---- tangent: rows ---- */

enum { SBI_ROWS_PER_TASK = 128 };

/* A row of a 3x3 block; as vector, its fourth number means nothing. Both forms give the same bits. */
#if SBI_HAS_LANES
typedef sbi_lanes sbi_batch_row;
#define SBI_ROW_AT(row, j) ((row)[j])
SBI_FORCE_INLINE sbi_batch_row sbi_batch_scale(sb_real a, const sb_real *b) { return a * SBI_LANES_AT(b); }
SBI_FORCE_INLINE sbi_batch_row sbi_batch_madd(sbi_batch_row sum, sb_real a, sbi_batch_row b) { return sum + a * b; }
SBI_FORCE_INLINE sbi_batch_row sbi_batch_add(sbi_batch_row a, sbi_batch_row b) { return a + b; }
#elif SBI_HAS_PAIRS
typedef struct sbi_batch_row {
    sbi_pair xy;
    sb_real z;
} sbi_batch_row;
#define SBI_ROW_AT(row, j) ((j) == 2 ? (row).z : (row).xy[(j)&1])
SBI_FORCE_INLINE sbi_batch_row sbi_batch_scale(sb_real a, const sb_real *b)
{
    sbi_batch_row row;
    row.xy = a * SBI_PAIR_AT(b);
    row.z = a * b[2];
    return row;
}
SBI_FORCE_INLINE sbi_batch_row sbi_batch_madd(sbi_batch_row sum, sb_real a, sbi_batch_row b)
{
    sum.xy += a * b.xy;
    sum.z += a * b.z;
    return sum;
}
SBI_FORCE_INLINE sbi_batch_row sbi_batch_add(sbi_batch_row a, sbi_batch_row b)
{
    a.xy += b.xy;
    a.z += b.z;
    return a;
}
#else
typedef sb_vec3 sbi_batch_row;
#define SBI_ROW_AT(row, j) ((j) == 0 ? (row).x : (j) == 1 ? (row).y : (row).z)
SBI_FORCE_INLINE sbi_batch_row sbi_batch_scale(sb_real a, const sb_real *b)
{
    return sb_v3(a * b[0], a * b[1], a * b[2]);
}
SBI_FORCE_INLINE sbi_batch_row sbi_batch_madd(sbi_batch_row sum, sb_real a, sbi_batch_row b)
{
    return sb_v3_madd(sum, a, b);
}
SBI_FORCE_INLINE sbi_batch_row sbi_batch_add(sbi_batch_row a, sbi_batch_row b) { return sb_v3_add(a, b); }
#endif

/* A block by its rows. By names: compilers that do not unroll keep an array of rows in memory, at twice the time. */
typedef struct sbi_batch_sum {
    sbi_batch_row r0, r1, r2;
} sbi_batch_sum;

/* One point's h_a h_b^T. */
SBI_FORCE_INLINE sbi_batch_sum sbi_batch_outer_point(const sb_real *a, const sb_real *b)
{
    sbi_batch_sum s;
    s.r0 = sbi_batch_scale(a[0], b);
    s.r1 = sbi_batch_scale(a[1], b);
    s.r2 = sbi_batch_scale(a[2], b);
    return s;
}

SBI_FORCE_INLINE sbi_batch_sum sbi_batch_add_sum(sbi_batch_sum a, sbi_batch_sum b)
{
    a.r0 = sbi_batch_add(a.r0, b.r0);
    a.r1 = sbi_batch_add(a.r1, b.r1);
    a.r2 = sbi_batch_add(a.r2, b.r2);
    return a;
}

/* a + factor b */
SBI_FORCE_INLINE sbi_batch_sum sbi_batch_madd_sum(sbi_batch_sum a, sb_real factor, sbi_batch_sum b)
{
    a.r0 = sbi_batch_madd(a.r0, factor, b.r0);
    a.r1 = sbi_batch_madd(a.r1, factor, b.r1);
    a.r2 = sbi_batch_madd(a.r2, factor, b.r2);
    return a;
}

/* Sum over the points of a cell of h_a h_b^T. */
SBI_FORCE_INLINE sbi_batch_sum sbi_batch_outer(const sb_real *a, const sb_real *b, const int q)
{
    sbi_batch_sum s = sbi_batch_outer_point(a, b);
    for (int p = 1; p < q; p++)
        s = sbi_batch_add_sum(s, sbi_batch_outer_point(a + 3 * p, b + 3 * p));
    return s;
}

/* What the loops over blocks know when they are compiled. */
typedef struct sbi_batch_kind {
    int n, q;
    int bits;  /* of a node in a pair */
    int mixed; /* 1: cells differ in lambda / mu; otherwise it can wait for the sum */
    int live;  /* 1: pairs are in rings */
} sbi_batch_kind;

/* s += S of a cell and two of its nodes; l += its lambda / mu times that, where cells differ in it. */
SBI_FORCE_INLINE void sbi_batch_add_pair(const sbi_assembly *assembly, int pair, const sbi_batch_kind kind,
                                         sbi_batch_sum *s, sbi_batch_sum *l)
{
    size_t e = (size_t)(pair >> 2 * kind.bits);
    const int q = kind.q, mask = (1 << kind.bits) - 1;
    const sb_real *h = assembly->rotated + e * (size_t)(3 * kind.n * q);
    sbi_batch_sum t = sbi_batch_outer(h + 3 * q * (pair >> kind.bits & mask), h + 3 * q * (pair & mask), q);
    *s = sbi_batch_add_sum(*s, t);
    if (kind.mixed)
        *l = sbi_batch_madd_sum(*l, assembly->ratios[e], t);
}

/* Row i of factor (l + s^T + trace I): of l and of s the i-th row and column, and the trace in its place. */
SBI_FORCE_INLINE void sbi_batch_block_row(sb_real factor, sbi_batch_row l, sb_real s0, sb_real s1, sb_real s2,
                                          sb_real t0, sb_real t1, sb_real t2, sb_real *out)
{
    out[0] = factor * (SBI_ROW_AT(l, 0) + s0 + t0);
    out[1] = factor * (SBI_ROW_AT(l, 1) + s1 + t1);
    out[2] = factor * (SBI_ROW_AT(l, 2) + s2 + t2);
}

/* The block of an edge. */
SBI_FORCE_INLINE void sbi_batch_block(const sbi_batch_job *job, int k, const sbi_batch_kind kind)
{
    const sbi_assembly *assembly = job->assembly;
    sb_real factor = job->factor, *out = job->matrix->blocks[k];
    static const sb_real zeros[4] = {0, 0, 0, 0};
    sbi_batch_sum s, l;
    sb_real trace;
    s.r0 = s.r1 = s.r2 = sbi_batch_scale(0, zeros);
    l = s;
    if (kind.live)
        for (int pair = job->matrix->live->heads[k]; pair >= 0; pair = sbi_live_next_pair(assembly->live, pair))
            sbi_batch_add_pair(assembly, pair, kind, &s, &l);
    else
        for (int p = assembly->pair_start[k]; p < assembly->pair_start[k + 1]; p++)
            sbi_batch_add_pair(assembly, assembly->pairs[p], kind, &s, &l);
    if (!kind.mixed)
        l = sbi_batch_madd_sum(l, assembly->ratios[0], s);
    trace = SBI_ROW_AT(s.r0, 0) + SBI_ROW_AT(s.r1, 1) + SBI_ROW_AT(s.r2, 2);
    sbi_batch_block_row(factor, l.r0, SBI_ROW_AT(s.r0, 0), SBI_ROW_AT(s.r1, 0), SBI_ROW_AT(s.r2, 0), trace, 0, 0, out);
    sbi_batch_block_row(factor, l.r1, SBI_ROW_AT(s.r0, 1), SBI_ROW_AT(s.r1, 1), SBI_ROW_AT(s.r2, 1), 0, trace, 0,
                        out + 3);
    sbi_batch_block_row(factor, l.r2, SBI_ROW_AT(s.r0, 2), SBI_ROW_AT(s.r1, 2), SBI_ROW_AT(s.r2, 2), 0, 0, trace,
                        out + 6);
}

SBI_FORCE_INLINE void sbi_batch_upper_rows(const sbi_batch_job *job, int index, const int n, const int q,
                                           const int mixed, const int live)
{
    sb_matrix *matrix = job->matrix;
    sbi_batch_kind kind;
    int begin = index * SBI_ROWS_PER_TASK;
    int end = begin + sbi_min_int(SBI_ROWS_PER_TASK, matrix->row_count - begin);
    kind.n = n;
    kind.q = q;
    kind.bits = sbi_batch_node_bits(n);
    kind.mixed = mixed;
    kind.live = live;
    for (int row = begin; row < end; row++) {
        for (int k = matrix->diagonal[row] + 1; k < matrix->row_end[row]; k++)
            sbi_batch_block(job, k, kind);
        if (n == 4 && job->assembly->patches)
            sbi_patches_add_upper(job->assembly, job->factors, job->factor, row, matrix);
    }
}

static void sbi_batch_upper_clouds(const sbi_batch_job *job, int index)
{
    int n = job->assembly->domain->nodes_per_cell;
    if (job->assembly->mixed)
        sbi_batch_upper_rows(job, index, n, 1, 1, 0);
    else
        sbi_batch_upper_rows(job, index, n, 1, 0, 0);
}

static void sbi_batch_upper(void *user, int index)
{
    const sbi_batch_job *job = (const sbi_batch_job *)user;
    int is_tet4 = sbi_batch_is_tet4(job->assembly), mixed = job->assembly->mixed;
    if (job->assembly->live) {
        if (mixed)
            sbi_batch_upper_rows(job, index, 4, 1, 1, 1);
        else
            sbi_batch_upper_rows(job, index, 4, 1, 0, 1);
    } else if (sbi_batch_is_cloud(job->assembly)) {
        sbi_batch_upper_clouds(job, index);
    } else if (is_tet4 && mixed)
        sbi_batch_upper_rows(job, index, 4, 1, 1, 0);
    else if (is_tet4)
        sbi_batch_upper_rows(job, index, 4, 1, 0, 0);
    else if (mixed)
        sbi_batch_upper_rows(job, index, 10, 4, 1, 0);
    else
        sbi_batch_upper_rows(job, index, 10, 4, 0, 0);
}

/* A block, two by two as it lies in memory where that pays. Both forms give the same bits. */
#if SBI_HAS_PAIRS
typedef struct sbi_batch_nine {
    sbi_pair p0, p2, p4, p6;
    sb_real p8;
} sbi_batch_nine;

SBI_FORCE_INLINE sbi_batch_nine sbi_batch_nine_at(const sb_real *b)
{
    sbi_batch_nine v;
    v.p0 = SBI_PAIR_AT(b), v.p2 = SBI_PAIR_AT(b + 2), v.p4 = SBI_PAIR_AT(b + 4), v.p6 = SBI_PAIR_AT(b + 6);
    v.p8 = b[8];
    return v;
}

SBI_FORCE_INLINE sbi_batch_nine sbi_batch_transposed_at(const sb_real *b)
{
    sbi_batch_nine v;
    v.p0 = sbi_pair_make(b[0], b[3]), v.p2 = sbi_pair_make(b[6], b[1]);
    v.p4 = sbi_pair_make(b[4], b[7]), v.p6 = sbi_pair_make(b[2], b[5]);
    v.p8 = b[8];
    return v;
}

SBI_FORCE_INLINE sbi_batch_nine sbi_batch_subtract_nine(sbi_batch_nine a, sbi_batch_nine b)
{
    a.p0 -= b.p0, a.p2 -= b.p2, a.p4 -= b.p4, a.p6 -= b.p6;
    a.p8 -= b.p8;
    return a;
}

SBI_FORCE_INLINE void sbi_batch_put_nine(sb_real *to, sbi_batch_nine v)
{
    sbi_pair *pairs = (sbi_pair *)(void *)to;
    pairs[0] = v.p0, pairs[1] = v.p2, pairs[2] = v.p4, pairs[3] = v.p6;
    to[8] = v.p8;
}
#else
typedef struct sbi_batch_nine {
    sb_real v[9];
} sbi_batch_nine;

SBI_FORCE_INLINE sbi_batch_nine sbi_batch_nine_at(const sb_real *b)
{
    sbi_batch_nine v;
    memcpy(v.v, b, sizeof v.v);
    return v;
}

SBI_FORCE_INLINE sbi_batch_nine sbi_batch_transposed_at(const sb_real *b)
{
    sbi_batch_nine v = {{b[0], b[3], b[6], b[1], b[4], b[7], b[2], b[5], b[8]}};
    return v;
}

SBI_FORCE_INLINE sbi_batch_nine sbi_batch_subtract_nine(sbi_batch_nine a, sbi_batch_nine b)
{
    for (int c = 0; c < 9; c++)
        a.v[c] -= b.v[c];
    return a;
}

SBI_FORCE_INLINE void sbi_batch_put_nine(sb_real *to, sbi_batch_nine v) { memcpy(to, v.v, sizeof v.v); }
#endif

/* Transposes below the diagonal, and the diagonal: a rigid translation costs nothing, so K_ii = - sum over j != i of
 * K_ij. */
static void sbi_batch_lower(void *user, int index)
{
    static const sb_real zeros[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
    sb_matrix *matrix = ((const sbi_batch_job *)user)->matrix;
    int begin = index * SBI_ROWS_PER_TASK;
    int end = begin + sbi_min_int(SBI_ROWS_PER_TASK, matrix->row_count - begin);
    for (int row = begin; row < end; row++) {
        int diagonal = matrix->diagonal[row];
        sbi_batch_nine sum = sbi_batch_nine_at(zeros);
        sb_real k_ii[9], *out = matrix->blocks[diagonal];
        for (int k = matrix->row_start[row]; k < diagonal; k++) {
            sbi_batch_nine block = sbi_batch_transposed_at(matrix->blocks[matrix->transpose[k]]);
            sum = sbi_batch_subtract_nine(sum, block);
            sbi_batch_put_nine(matrix->blocks[k], block);
        }
        for (int k = diagonal + 1; k < matrix->row_end[row]; k++)
            sum = sbi_batch_subtract_nine(sum, sbi_batch_nine_at(matrix->blocks[k]));
        sbi_batch_put_nine(k_ii, sum);
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                out[3 * i + j] = (sb_real)0.5 * (k_ii[3 * i + j] + k_ii[3 * j + i]);
    }
}

SBI_API void sbi_batch_tangent(sbi_assembly *assembly, const sb_real *factors, sb_real factor, sb_matrix *matrix)
{
    int tasks = (matrix->row_count - 1) / SBI_ROWS_PER_TASK + 1;
    sbi_batch_job job;
    job.assembly = assembly;
    job.matrix = matrix;
    job.factor = factor;
    job.factors = factors;
    if (assembly->patches)
        (void)sbi_patches_update(assembly, NULL, 1);
    sbi_run(assembly->jobs, sbi_batch_rotate_chunk, &job, assembly->chunk_count);
    sbi_run(assembly->jobs, sbi_batch_upper, &job, tasks);
    sbi_run(assembly->jobs, sbi_batch_lower, &job, tasks);
    sbi_matrix_set_free_rows(matrix);
}
