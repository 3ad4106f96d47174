/* assembly: loops over integration points. */
#include "assembly_batch.h"
#include "assembly_cell.h"
#include "assembly_live.h"
#include "assembly_patch.h"
#include "material_models.h"

#include <string.h>

/* ---- set-up ---- */

static void sbi_assembly_map_blocks(sbi_assembly *assembly, const sb_matrix *matrix)
{
    const sb_domain *domain = assembly->domain;
    int n = domain->nodes_per_cell, *out = assembly->scatter;
    for (int e = 0; e < domain->cell_count; e++) {
        const int *cell = domain->cells + (size_t)e * (size_t)n;
        for (int a = 0; a < n; a++)
            for (int b = a; b < n; b++)
                *out++ = sb_matrix_find(matrix, cell[a], cell[b]);
    }
}

SBI_API void sbi_assembly_reset_rotations(sbi_assembly *assembly)
{
    const sb_domain *domain = assembly->domain;
    size_t count = (size_t)domain->cell_count * (size_t)domain->points_per_cell;
    for (size_t i = 0; i < count; i++)
        assembly->rotations[i] = sb_quat_identity();
    sbi_batch_reset_rotations(assembly);
}

/* Copies the warm starts one way or the other. */
static void sbi_assembly_copy_rotations(sbi_assembly *assembly, int restore)
{
    const sb_domain *domain = assembly->domain;
    size_t bytes = (size_t)domain->cell_count * (size_t)domain->points_per_cell * sizeof(sb_quat);
    if (assembly->batched && assembly->batch_quats)
        sbi_batch_copy_rotations(assembly, restore);
    else
        memcpy(restore ? assembly->rotations : assembly->saved_rotations,
               restore ? assembly->saved_rotations : assembly->rotations, bytes);
}

SBI_API void sbi_assembly_save_rotations(sbi_assembly *assembly) { sbi_assembly_copy_rotations(assembly, 0); }
SBI_API void sbi_assembly_restore_rotations(sbi_assembly *assembly)
{
    sbi_assembly_copy_rotations(assembly, 1);
    sbi_assembly_begin_step(assembly, 0);
}

SBI_API int sbi_assembly_has_pairs(const sbi_assembly *assembly)
{
    return !assembly->domain->cell_capacity && sbi_batch_fits(assembly->domain);
}

SBI_API void sbi_assembly_remap(sbi_assembly *assembly, const sb_matrix *matrix, int *pair_start)
{
    if (assembly->patches)
        sbi_patches_map(assembly->patches, matrix);
    if (assembly->live) {
        sbi_assembly_map_rows(assembly, matrix);
        return;
    }
    sbi_assembly_map_blocks(assembly, matrix);
    if (sbi_assembly_has_pairs(assembly)) {
        assembly->pair_start = pair_start;
        sbi_batch_list_pairs(assembly, matrix);
    }
}

SBI_API void sbi_assembly_prepare(sbi_assembly *assembly, const sb_matrix *matrix, uint64_t *node_colours)
{
    if (assembly->domain->cell_capacity == 0) { /* else see sbi_assembly_make_live */
        sbi_assembly_colour(assembly, node_colours);
        sbi_assembly_map_blocks(assembly, matrix);
        if (sbi_batch_fits(assembly->domain))
            sbi_batch_list_pairs(assembly, matrix);
    }
    if (assembly->patches)
        sbi_patches_map(assembly->patches, matrix);
    if (sbi_batch_fits(assembly->domain))
        sbi_batch_fill(assembly);
    sbi_assembly_reset_rotations(assembly);
}

SBI_API void sbi_assembly_copy_cell(sbi_assembly *to, int cell, const sbi_assembly *from, int old)
{
    size_t q = (size_t)to->domain->points_per_cell;
    memcpy(to->rotations + (size_t)cell * q, from->rotations + (size_t)old * q, q * sizeof *to->rotations);
    sbi_batch_copy_cell(to, cell, from, old);
    if (to->history && from->history && to->terms == from->terms) {
        size_t stride = q * sbi_memory_stride(to);
        memcpy(to->history + (size_t)cell * stride, from->history + (size_t)old * stride, stride * sizeof(sb_real));
    }
}

SBI_API void sbi_assembly_free(sbi_assembly *assembly, const sb_allocator *allocator)
{
    sbi_free(allocator, assembly->history);
    sbi_free(allocator, assembly->prestress);
    sbi_patches_free(assembly->patches, allocator);
    sbi_assembly_free_live(assembly);
}

/* ---- chunks on threads ---- */

typedef enum sbi_assembly_work {
    SBI_WORK_FORCE,
    SBI_WORK_FORCE_ALONG,
    SBI_WORK_TANGENT,
    SBI_WORK_ENERGY,
    SBI_WORK_PRODUCT,
    SBI_WORK_ALONG
} sbi_assembly_work;

typedef struct sbi_assembly_job {
    sbi_assembly *assembly;
    sbi_assembly_work work;
    const int *chunks; /* of the running colour */
    const sb_vec3 *u, *x;
    int turned;
    const unsigned char *held; /* [node_count] products are for; NULL: all */
    sb_vec3 *force;
    sb_matrix *matrix;
    sb_tangent_kind kind;
    sb_real factor;
    const sb_real *factors; /* [material_count] of cells, in place of the one; or NULL */
} sbi_assembly_job;

static void sbi_assembly_chunk(void *user, int index);

/* Runs all chunks, colour by colour; the first bad cell or -1. */
static int sbi_assembly_run(sbi_assembly_job *job)
{
    sbi_assembly *assembly = job->assembly;
    sbi_assembly_settle_colours(assembly);
    for (int colour = 0; colour < assembly->colour_count; colour++) {
        int first = assembly->colour_start[colour];
        job->chunks = assembly->colour_chunks + first;
        sbi_run(assembly->jobs, sbi_assembly_chunk, job, assembly->colour_start[colour + 1] - first);
    }
    for (int c = 0; c < assembly->chunk_count; c++)
        if (assembly->chunk_bad_cell[c] >= 0)
            return assembly->chunk_bad_cell[c];
    return -1;
}

/* ---- one cell ---- */

/* What is special about a cell's points: */
enum {
    SBI_CELL_SINGLE = -1, /* they share one rotation, of their mean */
    SBI_CELL_PLAIN = 0,
    SBI_CELL_MEAN = 1, /* the last is the mean of the others; */
    SBI_CELL_MEANS = 4 /* the last four are */
};

static int sbi_cell_scheme(const sb_domain *domain)
{
    return domain->single_rotation ? SBI_CELL_SINGLE : domain->mean_points;
}

/* Points that are not means of others. */
SBI_FORCE_INLINE int sbi_cell_ordinary(const int q, const int scheme) { return scheme > 0 ? q - scheme : q; }

/* The materials of a cell's points and of its mean points. */
SBI_FORCE_INLINE const sb_material *sbi_cell_shares(const sbi_assembly *assembly, int e)
{
    return assembly->shares + 2 * (size_t)assembly->cell_material[e];
}

/* Updates the rotations of a cell of corotated material. Returns 1 when all points share one: by choice (single), or
 * because the cell is folded over. */
static int sbi_cell_rotate(const sbi_assembly *assembly, int e, const sb_vec3 *u, const sb_mat3 *f, int q, int scheme,
                           sb_quat *rotation)
{
    if (scheme != SBI_CELL_SINGLE) {
        for (int p = 0; p < q; p++)
            rotation[p] = sb_m3_polar(f[p], rotation[p]);
        return assembly->fold_fallback && sbi_assembly_fold_fallback(assembly, e, u, f, rotation);
    }
    rotation[0] =
        sb_m3_polar(sbi_assembly_mean_gradient(f, assembly->domain->weights + (size_t)e * (size_t)q, q), rotation[0]);
    for (int p = 1; p < q; p++)
        rotation[p] = rotation[0];
    return 1;
}

static int sbi_cell_is_corotated(const sb_material *material)
{
    return material->model == SB_COROTATED || material->model == SB_COROTATED_INVERTIBLE;
}

/* Corotated stress about a given rotation: P = R (lambda tr(e) I + 2 mu e), e = sym(R^T F) - I; *energy too. */
static sb_mat3 sbi_cell_rotated_stress(const sb_material *material, sb_mat3 f, sb_mat3 r, sb_real *energy)
{
    sb_mat3 b = sb_m3_tmul(r, f);
    sb_mat3 strain = sb_m3_sub(sb_m3_scale((sb_real)0.5, sb_m3_add(b, sb_m3_transpose(b))), sb_m3_identity());
    sb_real trace = sb_m3_trace(strain);
    sb_mat3 stress = sb_m3_scale(2 * material->mu, strain);
    for (int i = 0; i < 3; i++)
        stress.m[i][i] += material->lambda * trace;
    *energy = (sb_real)0.5 * sb_m3_ddot(stress, strain);
    return sb_m3_mul(r, stress);
}

/* ---- fibres and memory: what comes on top of the model's own response, in some materials only ---- */

static int sbi_cell_has_extras(const sb_material *material)
{
    return sbi_material_has_fibres(material) || material->prony_count > 0;
}

/* Ordinary points of a cell whose material has fibres, otherwise 0: mean points have none. */
static int sbi_cell_fibre_points(const sbi_assembly *assembly, const sb_material *material)
{
    const sb_domain *domain = assembly->domain;
    return sbi_material_has_fibres(material) ? domain->points_per_cell - domain->mean_points : 0;
}

/* Families of fibres, and the direction of one in a cell. */
static int sbi_cell_families(const sbi_assembly *assembly) { return assembly->second_fibres ? 2 : 1; }
static sb_vec3 sbi_cell_fibre(const sbi_assembly *assembly, int e, int family)
{
    return family ? assembly->second_fibres[e] : assembly->fibres[e];
}

/* The constant second Piola-Kirchhoff stress H of the present step at a point (symmetric). */
static sb_mat3 sbi_point_prestress(const sbi_assembly *assembly, int e, int p)
{
    const sb_real *h = assembly->prestress + 6 * ((size_t)e * (size_t)assembly->domain->points_per_cell + (size_t)p);
    return sb_m3_columns(sb_v3(h[0], h[3], h[5]), sb_v3(h[3], h[1], h[4]), sb_v3(h[5], h[4], h[2]));
}

/* P += fibres + F H at all points; 0, and its flag (flags may be NULL), where the fibres do not admit F. */
static int sbi_cell_add_extra_stresses(const sbi_assembly *assembly, int e, const sb_mat3 *f, sb_mat3 *stress,
                                       int *flags)
{
    const sb_material *material = sbi_cell_shares(assembly, e);
    const sb_real *weights = assembly->domain->weights + (size_t)e * (size_t)assembly->domain->points_per_cell;
    int admissible = 1;
    for (int p = 0; p < sbi_cell_fibre_points(assembly, material); p++)
        for (int k = 0; k < sbi_cell_families(assembly) && (weights[p] > 0 || flags); k++)
            if (!sbi_fibre_stress(material, &f[p], sbi_cell_fibre(assembly, e, k), &stress[p])) {
                admissible = 0;
                if (flags)
                    flags[p] = 0;
            }
    for (int p = 0; material->prony_count > 0 && p < assembly->domain->points_per_cell; p++)
        stress[p] = sb_m3_add(stress[p], sb_m3_mul(f[p], sbi_point_prestress(assembly, e, p)));
    return admissible;
}

/* *sum += energy of fibres, and H : E; 0 when a point has an inadmissible F. */
static int sbi_cell_add_extra_energy(const sbi_assembly *assembly, int e, const sb_mat3 *f, sb_real *sum)
{
    const sb_material *material = sbi_cell_shares(assembly, e);
    int q = assembly->domain->points_per_cell;
    const sb_real *weights = assembly->domain->weights + (size_t)e * (size_t)q;
    const sb_real factor = sbi_assembly_stiffness(assembly, e);
    for (int p = 0; p < sbi_cell_fibre_points(assembly, material); p++) {
        sb_real density = 0;
        if (weights[p] == 0)
            continue;
        for (int k = 0; k < sbi_cell_families(assembly); k++)
            if (!sbi_fibre_energy(material, &f[p], sbi_cell_fibre(assembly, e, k), &density))
                return 0;
        *sum += weights[p] * factor * density;
    }
    for (int p = 0; material->prony_count > 0 && p < q; p++)
        *sum += weights[p] * factor * sb_m3_ddot(sbi_point_prestress(assembly, e, p), sbi_green_strain(&f[p]));
    return 1;
}

/* A symmetric matrix without its negative eigenvalues. */
static sb_mat3 sbi_point_semidefinite(sb_mat3 a)
{
    sb_vec3 values;
    sb_mat3 vectors, sum = sb_m3_zero();
    sb_m3_eigen(a, &values, &vectors);
    const sb_real value[3] = {values.x, values.y, values.z};
    for (int k = 0; k < 3; k++)
        if (value[k] > 0) {
            sb_vec3 v = sb_m3_column(vectors, k);
            sum = sb_m3_add(sum, sb_m3_outer(sb_v3_scale(value[k], v), v));
        }
    return sum;
}

/* A_ijkl += fibres + delta_ik H_jl, without H's negative part when the tangent has to be semidefinite. */
static int sbi_point_add_extra_tangent(const sbi_assembly *assembly, int e, int p, const sb_mat3 *f,
                                       sb_tangent_kind kind, sb_real *tangent)
{
    const sb_material *material = sbi_cell_shares(assembly, e);
    sb_mat3 h;
    for (int k = 0; p < sbi_cell_fibre_points(assembly, material) && k < sbi_cell_families(assembly); k++)
        if (!sbi_fibre_tangent(material, f, sbi_cell_fibre(assembly, e, k), kind, tangent))
            return 0;
    if (material->prony_count == 0)
        return 1;
    h = sbi_point_prestress(assembly, e, p);
    if (kind != SB_TANGENT_EXACT)
        h = sbi_point_semidefinite(h);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            for (int l = 0; l < 3; l++)
                tangent[9 * (3 * i + j) + 3 * i + l] += h.m[j][l];
    return 1;
}

/* ---- force ---- */

/* Stresses of all points of a cell; 0 when one has an inadmissible F: its stress is 0 then, and its flag (flags may
 * be NULL). Points of weight 0 have no say, and without flags no stress. */
static int sbi_cell_stresses(const sbi_assembly *assembly, int e, const sb_vec3 *u, const sb_mat3 *f, sb_quat *rotation,
                             sb_mat3 *stress, int *flags)
{
    const sb_material *shares = sbi_cell_shares(assembly, e);
    const int q = assembly->domain->points_per_cell, scheme = sbi_cell_scheme(assembly->domain);
    const sb_real *weights = assembly->domain->weights + (size_t)e * (size_t)q;
    int corotated = sbi_cell_is_corotated(shares), admissible = 1;
    int shared = corotated && sbi_cell_rotate(assembly, e, u, f, q, scheme, rotation);
    for (int p = 0; p < q; p++) {
        const sb_material *material = shares + (p >= sbi_cell_ordinary(q, scheme));
        sb_real energy;
        int good = 1;
        stress[p] = sb_m3_zero();
        if (weights[p] == 0 && !flags)
            continue;
        if (shared || material->model == SB_COROTATED)
            stress[p] = sbi_cell_rotated_stress(material, f[p], sb_quat_to_mat3(rotation[p]), &energy);
        else
            good = sb_material_stress(material, &f[p], &rotation[p], &stress[p]);
        if (assembly->patches && good)
            sbi_patch_take_stress(shares + 1, &f[p], &stress[p]);
        admissible &= good;
        if (flags)
            flags[p] = good;
    }
    if (sbi_cell_has_extras(shares))
        admissible &= sbi_cell_add_extra_stresses(assembly, e, f, stress, flags);
    for (int p = 0; assembly->cell_stiffness && p < q; p++)
        stress[p] = sb_m3_scale(assembly->cell_stiffness[e], stress[p]);
    return admissible;
}

/* Adds to the stresses of a single-rotation cell what comes from its rotation. */
static void sbi_cell_add_turning_stress(const sbi_assembly *assembly, int e, const sb_mat3 *f, sb_quat rotation,
                                        sb_mat3 *stress)
{
    int q = assembly->domain->points_per_cell;
    const sb_real *weights = assembly->domain->weights + (size_t)e * (size_t)q;
    sb_mat3 sum = sb_m3_zero(), s;
    sb_real volume = 0;
    sb_vec3 moment;
    for (int p = 0; p < q; p++) {
        volume += weights[p];
        sum = sb_m3_add(sum, sb_m3_scale(weights[p], sb_m3_mult(stress[p], f[p])));
    }
    if (!(volume > 0))
        return;
    moment = sb_v3(sum.m[1][2] - sum.m[2][1], sum.m[2][0] - sum.m[0][2], sum.m[0][1] - sum.m[1][0]);
    s = sbi_assembly_turning_stress(sb_quat_to_mat3(rotation), sbi_assembly_mean_gradient(f, weights, q), moment,
                                    volume * sbi_assembly_stiffness(assembly, e) * sbi_cell_shares(assembly, e)->mu);
    for (int p = 0; p < q; p++)
        stress[p] = sb_m3_add(stress[p], sb_m3_scale(1 / volume, s));
}

SBI_FORCE_INLINE int sbi_chunk_force(const sbi_assembly_job *job, int begin, int end, const int n)
{
    const sbi_assembly *assembly = job->assembly;
    const sb_domain *domain = assembly->domain;
    const int q = domain->points_per_cell;
    int bad = -1;
    for (int e = begin; e < end; e++) {
        const int *cell = domain->cells + (size_t)e * (size_t)n;
        sb_quat *rotation = assembly->rotations + (size_t)e * (size_t)q;
        sb_mat3 f[SBI_CELL_POINTS], stress[SBI_CELL_POINTS];
        sb_real force[SB_MAX_ELEMENT_NODES][3];
        if (sbi_domain_is_free(assembly->domain, e))
            continue;
        sbi_cell_deformations(domain, e, job->u, n, q, f);
        if (!sbi_cell_stresses(assembly, e, job->u, f, rotation, stress, NULL) && bad < 0)
            bad = e;
        if (domain->single_rotation)
            sbi_cell_add_turning_stress(assembly, e, f, rotation[0], stress);
        for (int a = 0; a < n; a++)
            force[a][0] = force[a][1] = force[a][2] = 0;
        for (int p = 0; p < q; p++) {
            size_t at = (size_t)e * (size_t)q + (size_t)p;
            const sb_real *g = domain->gradients + at * 3 * (size_t)n;
            sb_mat3 s = sb_m3_scale(domain->weights[at], stress[p]);
            for (int a = 0; a < n; a++)
                for (int i = 0; i < 3; i++)
                    force[a][i] += s.m[i][0] * g[3 * a] + s.m[i][1] * g[3 * a + 1] + s.m[i][2] * g[3 * a + 2];
        }
        for (int a = 0; a < n; a++) {
            job->force[cell[a]].x += force[a][0];
            job->force[cell[a]].y += force[a][1];
            job->force[cell[a]].z += force[a][2];
        }
    }
    return bad;
}

/* ---- energy ---- */

/* Energy of a cell; 0 when one of its points has an inadmissible F. */
static int sbi_cell_energy(const sbi_assembly *assembly, int e, const sb_vec3 *u, const sb_mat3 *f, sb_real *sum)
{
    const sb_material *shares = sbi_cell_shares(assembly, e);
    const int q = assembly->domain->points_per_cell, scheme = sbi_cell_scheme(assembly->domain);
    const sb_quat *start = assembly->rotations + (size_t)e * (size_t)q;
    const sb_real *weights = assembly->domain->weights + (size_t)e * (size_t)q;
    const sb_real factor = sbi_assembly_stiffness(assembly, e);
    sb_quat rotation[SBI_CELL_POINTS];
    int shared;
    for (int p = 0; p < q; p++)
        rotation[p] = start[p];
    shared = sbi_cell_is_corotated(shares) && sbi_cell_rotate(assembly, e, u, f, q, scheme, rotation);
    for (int p = 0; p < q; p++) {
        const sb_material *material = shares + (p >= sbi_cell_ordinary(q, scheme));
        sb_real density = 0;
        if (weights[p] == 0)
            continue;
        if (shared || material->model == SB_COROTATED)
            sbi_cell_rotated_stress(material, f[p], sb_quat_to_mat3(rotation[p]), &density);
        else if (!sb_material_energy(material, &f[p], &rotation[p], &density))
            return 0;
        if (assembly->patches)
            sbi_patch_take_energy(shares + 1, &f[p], &density);
        *sum += weights[p] * factor * density;
    }
    return !sbi_cell_has_extras(shares) || sbi_cell_add_extra_energy(assembly, e, f, sum);
}

SBI_FORCE_INLINE int sbi_chunk_energy(const sbi_assembly_job *job, int begin, int end, const int n, sb_real *sum)
{
    const sbi_assembly *assembly = job->assembly;
    *sum = 0;
    for (int e = begin; e < end; e++) {
        sb_mat3 f[SBI_CELL_POINTS];
        if (sbi_domain_is_free(assembly->domain, e))
            continue;
        sbi_cell_deformations(assembly->domain, e, job->u, n, assembly->domain->points_per_cell, f);
        if (!sbi_cell_energy(assembly, e, job->u, f, sum))
            return e;
    }
    return -1;
}

/* ---- tangent ---- */

/* Tangent blocks of a cell while they are summed: entry (i, k) of block (a, b) is at [(9 a + 3 i + k) width + b]. The
 * node b runs fastest, so that the loops over it become vector instructions, to an even width because gcc's -O2 makes
 * none of others; blocks below the diagonal are summed along because that costs less than leaving them out. */
typedef sb_real sbi_cell_blocks[SB_MAX_ELEMENT_NODES * 9 * SB_MAX_ELEMENT_NODES];
SBI_FORCE_INLINE int sbi_cell_width(const int n) { return n + n % 2; } /* of n nodes */

/* Adds the blocks (a, b >= a) of a cell to the matrix, and their transposes below the diagonal. */
SBI_FORCE_INLINE void sbi_cell_scatter(sb_matrix *matrix, const int *at, const sb_real *blocks, const int n)
{
    const int width = sbi_cell_width(n);
    for (int a = 0; a < n; a++)
        for (int b = a; b < n; b++, at++) {
            sb_real *upper = matrix->blocks[*at], *lower = matrix->blocks[matrix->transpose[*at]];
            for (int i = 0; i < 3; i++)
                for (int k = 0; k < 3; k++) {
                    sb_real value = blocks[(9 * a + 3 * i + k) * width + b];
                    upper[3 * i + k] += value;
                    if (a != b)
                        lower[3 * k + i] += value;
                }
        }
}

/* blocks += w (lambda h_a h_b^T + mu h_b h_a^T + mu h_a.h_b I) with h = R g (rotated-gradient identity). */
SBI_FORCE_INLINE void sbi_cell_add_rotated(sb_mat3 r, const sb_real *g, sb_real lambda, sb_real mu, const int n,
                                           sb_real *SB_RESTRICT blocks)
{
    const int width = sbi_cell_width(n);
    sb_real h[3][SB_MAX_ELEMENT_NODES], dot[SB_MAX_ELEMENT_NODES];
    for (int i = 0; n < width && i < 3; i++)
        h[i][n] = 0;
    for (int a = 0; a < n; a++)
        for (int i = 0; i < 3; i++)
            h[i][a] = r.m[i][0] * g[3 * a] + r.m[i][1] * g[3 * a + 1] + r.m[i][2] * g[3 * a + 2];
    for (int a = 0; a < n; a++) {
        sb_real l[3] = {lambda * h[0][a], lambda * h[1][a], lambda * h[2][a]};
        sb_real m[3] = {mu * h[0][a], mu * h[1][a], mu * h[2][a]};
        for (int b = 0; b < width; b++)
            dot[b] = m[0] * h[0][b] + m[1] * h[1][b] + m[2] * h[2][b];
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++) {
                sb_real *SB_RESTRICT out = blocks + (9 * a + 3 * i + k) * width;
                for (int b = 0; b < width; b++)
                    out[b] += l[i] * h[k][b] + m[k] * h[i][b] + (i == k ? dot[b] : (sb_real)0);
            }
    }
}

/* blocks += w g_a . A . g_b with A = dP/dF, A[9 (3 i + j) + 3 k + l] = dP_ij / dF_kl. */
SBI_FORCE_INLINE void sbi_cell_add_tangent(const sb_real *tangent, const sb_real *g, sb_real w, const int n,
                                           sb_real *SB_RESTRICT blocks)
{
    const int width = sbi_cell_width(n);
    sb_real by_axis[3][SB_MAX_ELEMENT_NODES];
    for (int l = 0; n < width && l < 3; l++)
        by_axis[l][n] = 0;
    for (int b = 0; b < n; b++)
        for (int l = 0; l < 3; l++)
            by_axis[l][b] = g[3 * b + l];
    for (int a = 0; a < n; a++) {
        sb_real t[3][9]; /* t[i][kl] = w sum_j g_a,j A_ijkl */
        for (int i = 0; i < 3; i++)
            for (int kl = 0; kl < 9; kl++)
                t[i][kl] = w * (g[3 * a] * tangent[27 * i + kl] + g[3 * a + 1] * tangent[27 * i + 9 + kl] +
                                g[3 * a + 2] * tangent[27 * i + 18 + kl]);
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++) {
                sb_real *SB_RESTRICT out = blocks + (9 * a + 3 * i + k) * width;
                for (int b = 0; b < width; b++)
                    out[b] +=
                        t[i][3 * k] * by_axis[0][b] + t[i][3 * k + 1] * by_axis[1][b] + t[i][3 * k + 2] * by_axis[2][b];
            }
    }
}

/* 1 when R C R^T is the tangent asked for, so that rotated gradients do. */
static int sbi_assembly_is_rotated(const sb_material *material, sb_tangent_kind kind)
{
    return material->model == SB_LINEAR || (sbi_cell_is_corotated(material) && kind == SB_TANGENT_QUASI);
}

/* The geometric part of a tangent takes the second Piola-Kirchhoff stress that was expected at the end of the increment
 * from F_before, linearly, in place of the one that is (mixed integration points: Magisano, Leonetti and Garcea 2017):
 *     S - C : G,  G = dF^T dF / 2,  dF = F - F_before,  since E(F) = E(F_before) + sym(F_before^T dF) + G.
 * With H = F^-T G, A : H = H S + F (C : G). */
static void sbi_point_mix(const sb_material *material, const sb_mat3 *f, const sb_mat3 *before, sb_quat rotation,
                          sb_real *tangent)
{
    sb_mat3 d = sb_m3_sub(*f, *before), h, change = sb_m3_zero(), stress, inverse;
    if (!(sb_abs(sb_m3_det(*f)) > SB_EPSILON) || !sb_material_stress(material, f, &rotation, &stress))
        return;
    inverse = sb_m3_inverse(*f);
    h = sb_m3_mult(sb_m3_transpose(inverse), sb_m3_scale((sb_real)0.5, sb_m3_mult(sb_m3_transpose(d), d)));
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 3; k++)
                for (int l = 0; l < 3; l++)
                    change.m[i][j] += tangent[9 * (3 * i + j) + 3 * k + l] * h.m[k][l];
    change = sb_m3_sub(change, sb_m3_mult(h, sb_m3_mult(inverse, stress)));
    change = sb_m3_mult(inverse, change);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            for (int l = 0; l < 3; l++)
                tangent[9 * (3 * i + j) + 3 * i + l] -= (change.m[j][l] + change.m[l][j]) / 2;
}

/* Sums the tangent blocks of a cell; 0 when a point has an inadmissible F. */
SBI_FORCE_INLINE int sbi_cell_tangent(const sbi_assembly_job *job, int e, const int n, sb_real *blocks)
{
    const sbi_assembly *assembly = job->assembly;
    const sb_domain *domain = assembly->domain;
    const sb_material *shares = sbi_cell_shares(assembly, e);
    const int q = domain->points_per_cell, scheme = sbi_cell_scheme(domain);
    const int rotated = sbi_assembly_is_rotated(shares, job->kind);
    const int extras = sbi_cell_has_extras(shares);
    const sb_quat *rotation = assembly->rotations + (size_t)e * (size_t)q;
    const int mixed = assembly->came_from && !rotated && job->kind == SB_TANGENT_EXACT;
    const sb_real factor =
        (job->factors ? job->factors[assembly->cell_material[e]] : job->factor) * sbi_assembly_stiffness(assembly, e);
    sb_mat3 f[SBI_CELL_POINTS], before[SBI_CELL_POINTS];
    for (int k = 0; k < (rotated ? 0 : 1 + mixed); k++)
        sbi_cell_deformations(domain, e, k ? assembly->came_from : job->u, n, q, k ? before : f);
    for (int p = 0; p < q; p++) {
        size_t point = (size_t)e * (size_t)q + (size_t)p;
        const sb_material *material = shares + (p >= sbi_cell_ordinary(q, scheme));
        const sb_real *g = domain->gradients + point * 3 * (size_t)n;
        sb_real w = domain->weights[point] * factor, tangent[81];
        sb_quat start = rotation[p];
        if (domain->weights[point] == 0)
            continue;
        if (rotated) {
            sb_mat3 r = material->model == SB_LINEAR ? sb_m3_identity() : sb_quat_to_mat3(start);
            sbi_cell_add_rotated(r, g, w * material->lambda, w * material->mu, n, blocks);
        } else {
            sb_material own;
            if (assembly->patches) {
                own = sbi_patch_tangent_share(material);
                material = &own;
            }
            if (!sb_material_tangent(material, &f[p], &start, assembly->patches ? SB_TANGENT_EXACT : job->kind,
                                     tangent))
                return 0;
            if (mixed)
                sbi_point_mix(material, &f[p], &before[p], start, tangent);
            if (extras && !sbi_point_add_extra_tangent(assembly, e, p, &f[p], job->kind, tangent))
                return 0;
            if (assembly->patches && !sbi_patches_finish_tangent(assembly, e, &f[p], start, job->kind, tangent))
                return 0;
            sbi_cell_add_tangent(tangent, g, w, n, blocks);
        }
    }
    return 1;
}

SBI_FORCE_INLINE int sbi_chunk_tangent(const sbi_assembly_job *job, int begin, int end, const int n)
{
    const int pair_count = n * (n + 1) / 2;
    int bad = -1;
    for (int e = begin; e < end; e++) {
        const int *at = job->assembly->scatter + (size_t)e * (size_t)pair_count;
        sbi_cell_blocks blocks;
        if (sbi_domain_is_free(job->assembly->domain, e))
            continue;
        memset(blocks, 0, (size_t)(9 * n * sbi_cell_width(n)) * sizeof blocks[0]);
        if (!sbi_cell_tangent(job, e, n, blocks) && bad < 0)
            bad = e;
        sbi_cell_scatter(job->matrix, at, blocks, n);
    }
    return bad;
}

/* ---- instances per element type ---- */

/* Numbers of nodes are literals, which the loops over them gain from. What is done at a point costs too much for its
 * number to. */
#define SBI_EACH_ELEMENT(CALL)                                                                                         \
    switch (sbi_element_type_or_pinned(domain->element_type)) {                                                        \
    case SB_TET4: CALL(4); break;                                                                                      \
    case SB_TET10: CALL(10); break;                                                                                    \
    case SB_HEX8: CALL(8); break;                                                                                      \
    case SB_HEX20: CALL(20); break;                                                                                    \
    case SB_HEX27: CALL(27); break;                                                                                    \
    default: CALL(domain->nodes_per_cell); break;                                                                      \
    }

static int sbi_chunk_force_any(sbi_assembly_job *job, int begin, int end)
{
    const sb_domain *domain = job->assembly->domain;
    if (job->assembly->batched) {
        sbi_batch_force(job->assembly, job->u, job->force, begin, end);
        return -1;
    }
#define SBI_CALL(n) return sbi_chunk_force(job, begin, end, n)
    SBI_EACH_ELEMENT(SBI_CALL)
#undef SBI_CALL
    return -1;
}

static int sbi_chunk_tangent_any(const sbi_assembly_job *job, int begin, int end)
{
    const sb_domain *domain = job->assembly->domain;
#define SBI_CALL(n) return sbi_chunk_tangent(job, begin, end, n)
    SBI_EACH_ELEMENT(SBI_CALL)
#undef SBI_CALL
    return -1;
}

static int sbi_chunk_energy_any(const sbi_assembly_job *job, int begin, int end, sb_real *sum)
{
    const sb_domain *domain = job->assembly->domain;
    if (job->assembly->batched && !domain->single_rotation) {
        *sum = sbi_batch_energy(job->assembly, job->u, begin, end);
        return -1;
    }
#define SBI_CALL(n) return sbi_chunk_energy(job, begin, end, n, sum)
    SBI_EACH_ELEMENT(SBI_CALL)
#undef SBI_CALL
    return -1;
}
#undef SBI_EACH_ELEMENT

static void sbi_assembly_chunk(void *user, int index)
{
    sbi_assembly_job *job = (sbi_assembly_job *)user;
    sbi_assembly *assembly = job->assembly;
    int chunk = job->chunks[index], begin = chunk * assembly->chunk_size;
    int end = sbi_assembly_chunk_end(assembly, chunk), bad = -1;
    switch (job->work) {
    case SBI_WORK_FORCE: bad = sbi_chunk_force_any(job, begin, end); break;
    case SBI_WORK_FORCE_ALONG:
        sbi_batch_force_along(assembly, job->u, job->x, job->turned, job->force, begin, end);
        break;
    case SBI_WORK_TANGENT: bad = sbi_chunk_tangent_any(job, begin, end); break;
    case SBI_WORK_ENERGY: bad = sbi_chunk_energy_any(job, begin, end, &assembly->chunk_energy[chunk]); break;
    case SBI_WORK_PRODUCT: sbi_batch_multiply(assembly, job->u, job->held, job->force, begin, end); break;
    case SBI_WORK_ALONG: assembly->chunk_energy[chunk] = sbi_batch_work(assembly, job->u, begin, end); break;
    }
    assembly->chunk_bad_cell[chunk] = bad;
}

/* ---- entry points ---- */

/* Shares of the materials as they are, and of what relaxes of them, which in patches is all the points'. */
static void sbi_assembly_derive(sbi_assembly *assembly)
{
    const sb_domain *domain = assembly->domain;
    for (int i = 0; i < assembly->material_count; i++) {
        const sb_material *material = assembly->materials + i;
        sb_material relaxing = sbi_material_relaxing(material);
        for (int k = 0; k < 2; k++) {
            assembly->shares[2 * i + k] = sbi_assembly_share(domain, material, k);
            assembly->relaxing[2 * i + k] = domain->cell_patch ? relaxing : sbi_assembly_share(domain, &relaxing, k);
        }
    }
}

SBI_API void sbi_assembly_set_materials(sbi_assembly *assembly, const sb_material *materials, int material_count,
                                        const int *cell_material)
{
    const sb_domain *domain = assembly->domain;
    int q = domain->points_per_cell;
    assembly->materials = materials;
    assembly->material_count = material_count;
    assembly->cell_material = cell_material;
    assembly->batched = sbi_batch_fits(domain);
    assembly->viscous = 0;
    assembly->energy_unit = 0;
    for (int e = 0; e < domain->cell_count; e++)
        for (int p = 0; p < q - domain->mean_points; p++) {
            const sb_material *material = materials + cell_material[e];
            assembly->energy_unit += domain->weights[(size_t)e * (size_t)q + (size_t)p] *
                                     sbi_assembly_stiffness(assembly, e) * (material->lambda + 2 * material->mu);
        }
    if (assembly->live)
        sbi_assembly_weigh_all(assembly);
    for (int i = 0; i < material_count; i++) {
        if (materials[i].model != SB_COROTATED)
            assembly->batched = 0;
        assembly->viscous |= materials[i].prony_count > 0;
    }
    if (assembly->batched)
        sbi_batch_set_materials(assembly);
    sbi_assembly_derive(assembly);
    sbi_assembly_begin_step(assembly, 0);
}

static sbi_assembly_job sbi_assembly_make_job(sbi_assembly *assembly, sbi_assembly_work work, const sb_vec3 *u)
{
    sbi_assembly_job job;
    memset(&job, 0, sizeof job);
    job.assembly = assembly;
    job.work = work;
    job.u = u;
    job.factor = 1;
    job.kind = SB_TANGENT_EXACT;
    return job;
}

/* The first of two cells, of which each may be -1: none. */
static int sbi_assembly_first_bad(int bad, int other) { return bad < 0 || (other >= 0 && other < bad) ? other : bad; }

SBI_API int sbi_assembly_force(sbi_assembly *assembly, const sb_vec3 *u, sb_vec3 *force)
{
    sbi_assembly_job job = sbi_assembly_make_job(assembly, SBI_WORK_FORCE, u);
    int bad;
    job.force = force;
    memset(force, 0, (size_t)assembly->domain->node_count * sizeof *force);
    bad = sbi_assembly_run(&job);
    if (assembly->patches)
        bad = sbi_assembly_first_bad(bad, sbi_patches_add_force(assembly, u, NULL, force));
    if (assembly->rows)
        sbi_rows_add_force(assembly->rows, u, force);
    if (assembly->glue)
        sbi_glue_add_force(assembly->glue, u, force);
    return bad;
}

SBI_API void sbi_assembly_force_along(sbi_assembly *assembly, const sb_vec3 *u, const sb_vec3 *x, int turned,
                                      sb_vec3 *force)
{
    sbi_assembly_job job = sbi_assembly_make_job(assembly, SBI_WORK_FORCE_ALONG, u);
    job.x = x;
    job.turned = turned;
    job.force = force;
    memset(force, 0, (size_t)assembly->domain->node_count * sizeof *force);
    (void)sbi_assembly_run(&job);
    if (assembly->patches)
        (void)sbi_patches_add_force(assembly, u, x, force);
}

SBI_API int sbi_assembly_add_share(sbi_assembly *assembly, const sb_vec3 *u, int index, const sb_material *material,
                                   sb_vec3 *force)
{
    sbi_assembly own = *assembly;
    sbi_assembly_job job = sbi_assembly_make_job(&own, SBI_WORK_FORCE, u);
    sb_material *shares = assembly->shares + 2 * (size_t)index, kept[2];
    sb_quat rotation[SBI_CELL_POINTS];
    size_t q = (size_t)assembly->domain->points_per_cell;
    int bad = -1;
    own.batched = 0;
    job.force = force;
    memcpy(kept, shares, sizeof kept);
    for (int k = 0; k < 2; k++)
        shares[k] = sbi_assembly_share(assembly->domain, material, k);
    for (int e = 0; e < assembly->domain->cell_count && bad < 0; e++) {
        if (assembly->cell_material[e] != index)
            continue;
        memcpy(rotation, assembly->rotations + (size_t)e * q, q * sizeof *rotation);
        bad = sbi_chunk_force_any(&job, e, e + 1);
        memcpy(assembly->rotations + (size_t)e * q, rotation, q * sizeof *rotation);
    }
    if (assembly->patches && bad < 0)
        bad = sbi_patches_add_share(assembly, u, index, force);
    memcpy(shares, kept, sizeof kept);
    return bad;
}

SBI_API int sbi_assembly_tangent(sbi_assembly *assembly, const sb_vec3 *u, sb_tangent_kind kind, sb_real factor,
                                 sb_matrix *matrix)
{
    return sbi_assembly_weighted_tangent(assembly, u, kind, NULL, factor, matrix);
}

SBI_API int sbi_assembly_weighted_tangent(sbi_assembly *assembly, const sb_vec3 *u, sb_tangent_kind kind,
                                          const sb_real *factors, sb_real factor, sb_matrix *matrix)
{
    sbi_assembly_job job = sbi_assembly_make_job(assembly, SBI_WORK_TANGENT, u);
    int bad, outer = -1;
    job.kind = kind;
    job.factor = factor;
    job.factors = factors;
    job.matrix = matrix;
    if (assembly->batched && kind == SB_TANGENT_QUASI) {
        sbi_batch_tangent(assembly, factors, factors ? 1 : factor, matrix);
        bad = -1;
    } else {
        memset(matrix->blocks, 0, (size_t)matrix->block_count * sizeof matrix->blocks[0]);
        sbi_assembly_settle_maps(assembly, matrix);
        if (assembly->patches)
            outer = sbi_patches_update(assembly, u, 1);
        bad = sbi_assembly_run(&job);
        if (assembly->patches)
            sbi_patches_add_tangent(assembly, kind, factors, factor, matrix);
        sbi_matrix_set_free_rows(matrix);
    }
    if (assembly->rows)
        sbi_rows_add_tangent(assembly->rows, factor, matrix);
    if (assembly->glue)
        sbi_glue_add_tangent(assembly->glue, factor, matrix);
    return sbi_assembly_first_bad(bad, outer);
}

SBI_API int sbi_assembly_multiply(sbi_assembly *assembly, const sb_vec3 *x, sb_vec3 *y)
{
    return sbi_assembly_multiply_held(assembly, x, NULL, y);
}

SBI_API int sbi_assembly_multiply_held(sbi_assembly *assembly, const sb_vec3 *x, const unsigned char *held, sb_vec3 *y)
{
    sbi_assembly_job job = sbi_assembly_make_job(assembly, SBI_WORK_PRODUCT, x);
    if (!assembly->batched)
        return 0;
    job.force = y;
    job.held = held;
    memset(y, 0, (size_t)assembly->domain->node_count * sizeof *y);
    sbi_assembly_run(&job);
    if (assembly->patches)
        sbi_patches_add_product(assembly, x, y);
    if (assembly->rows)
        sbi_rows_add_force(assembly->rows, x, y);
    if (assembly->glue)
        sbi_glue_add_force(assembly->glue, x, y);
    return 1;
}

static sb_real sbi_assembly_sum_chunks(const sbi_assembly *assembly)
{
    sb_real sum = 0;
    for (int c = 0; c < assembly->chunk_count; c++)
        sum += assembly->chunk_energy[c];
    return sum;
}

SBI_API sb_real sbi_assembly_work_along(sbi_assembly *assembly, const sb_vec3 *x)
{
    sbi_assembly_job job = sbi_assembly_make_job(assembly, SBI_WORK_ALONG, x);
    (void)sbi_assembly_run(&job);
    return sbi_assembly_sum_chunks(assembly) + (assembly->patches ? sbi_patches_work(assembly, x) : 0);
}

SBI_API int sbi_assembly_energy(sbi_assembly *assembly, const sb_vec3 *u, sb_real *energy)
{
    sbi_assembly_job job = sbi_assembly_make_job(assembly, SBI_WORK_ENERGY, u);
    int bad = sbi_assembly_run(&job);
    sb_real sum = sbi_assembly_sum_chunks(assembly), outer = 0;
    if (assembly->patches)
        bad = sbi_assembly_first_bad(bad, sbi_patches_energy(assembly, u, &outer));
    sum += outer;
    if (assembly->rows)
        sum += sbi_rows_energy(assembly->rows, u);
    if (assembly->glue)
        sum += sbi_glue_energy(assembly->glue, u);
    *energy = sum;
    return bad;
}

SBI_API void sbi_assembly_points(const sbi_assembly *assembly, const sb_vec3 *u, int cell, sb_mat3 *f, sb_mat3 *p,
                                 int *admissible)
{
    const sb_domain *domain = assembly->domain;
    int q = domain->points_per_cell;
    const sb_quat *start = assembly->rotations + (size_t)cell * (size_t)q;
    sb_quat rotation[SBI_CELL_POINTS];
    for (int i = 0; i < q; i++)
        rotation[i] = start[i];
    sbi_cell_deformations(domain, cell, u, domain->nodes_per_cell, q, f);
    sbi_cell_stresses(assembly, cell, u, f, rotation, p, admissible);
    if (assembly->patches)
        admissible[0] &= sbi_patches_cell_stress(assembly, cell, u, p);
}

SBI_API int sbi_assembly_cell_energy(const sbi_assembly *assembly, const sb_vec3 *u, int cell, sb_real *energy)
{
    const sb_domain *domain = assembly->domain;
    sb_mat3 f[SBI_CELL_POINTS];
    sb_real sum = 0;
    sbi_cell_deformations(domain, cell, u, domain->nodes_per_cell, domain->points_per_cell, f);
    if (!sbi_cell_energy(assembly, cell, u, f, &sum))
        return 0;
    if (assembly->patches && !sbi_patches_cell_energy(assembly, cell, u, &sum))
        return 0;
    *energy = sum;
    return 1;
}
