/* assembly_memory: what points of materials with Prony terms remember of viscous stress. */
#include "assembly_cell.h"
#include "assembly_patch.h"
#include "material_models.h"

#include <string.h>

static size_t sbi_memory_points(const sbi_assembly *assembly)
{
    return (size_t)assembly->domain->cell_count * (size_t)assembly->domain->points_per_cell;
}

SBI_API sb_result sbi_assembly_reserve_memory(sbi_assembly *assembly, int terms, const sb_allocator *allocator,
                                              sb_error *error)
{
    size_t points = (size_t)sbi_assembly_cell_room(assembly->domain) * (size_t)assembly->domain->points_per_cell;
    size_t old_stride = sbi_memory_stride(assembly), stride;
    sb_real *history, *prestress = assembly->prestress;
    if (terms <= assembly->terms)
        return SB_OK;
    stride = 6 * (1 + (size_t)terms);
    history =
        (sb_real *)sbi_alloc_zeroed(allocator, points, 2 * stride * sizeof(sb_real)); /* and what is saved of it */
    if (!prestress)
        prestress = (sb_real *)sbi_alloc_zeroed(allocator, points, 6 * sizeof(sb_real));
    if (!history || !prestress) {
        sbi_free(allocator, history);
        if (!assembly->prestress)
            sbi_free(allocator, prestress);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the %d Prony terms of %d elements", terms,
                        assembly->domain->cell_count);
    }
    for (size_t p = 0; assembly->history && p < sbi_memory_points(assembly); p++)
        memcpy(history + p * stride, assembly->history + p * old_stride, old_stride * sizeof(sb_real));
    sbi_free(allocator, assembly->history);
    assembly->history = history;
    assembly->prestress = prestress;
    assembly->terms = terms;
    return SB_OK;
}

/* Copies the memory to the second half of its block, or back. */
static void sbi_memory_copy(sbi_assembly *assembly, int restore)
{
    size_t bytes = 0, count;
    sb_real *history = sbi_assembly_memory(assembly, &bytes);
    count = bytes / sizeof(sb_real);
    if (history)
        memcpy(restore ? history : history + count, restore ? history + count : history, bytes);
}

SBI_API void sbi_assembly_save_memory(sbi_assembly *assembly) { sbi_memory_copy(assembly, 0); }
SBI_API void sbi_assembly_restore_memory(sbi_assembly *assembly) { sbi_memory_copy(assembly, 1); }

SBI_API void sbi_assembly_drop_prestress(sbi_assembly *assembly)
{
    if (assembly->viscous)
        memset(assembly->prestress, 0, sbi_memory_points(assembly) * 6 * sizeof(sb_real));
}

SBI_API sb_real *sbi_assembly_memory(sbi_assembly *assembly, size_t *bytes)
{
    *bytes = assembly->viscous ? sbi_memory_points(assembly) * sbi_memory_stride(assembly) * sizeof(sb_real) : 0;
    return assembly->viscous ? assembly->history : NULL;
}

/* The shares of materials with Prony terms for a step of dt. */
static void sbi_memory_relax(sbi_assembly *assembly, sb_real dt)
{
    for (int i = 0; i < assembly->material_count; i++) {
        const sb_material *material = assembly->materials + i;
        sb_material relaxed;
        if (material->prony_count == 0)
            continue;
        relaxed = sbi_material_relaxed(material, sbi_prony_factor(material, dt));
        assembly->shares[2 * i] = sbi_assembly_share(assembly->domain, &relaxed, 0);
        if (assembly->domain->cell_patch) /* what patches have does not relax */
            assembly->shares[2 * i].lambda += sbi_patch_kept_lambda(material, &relaxed);
        else
            assembly->shares[2 * i + 1] = sbi_assembly_share(assembly->domain, &relaxed, 1);
    }
}

/* What J F^-1 P is to be multiplied with for the S0 that a point remembers: 1/J, but nothing where a model that may be
 * inside out is, and a continuous way between. S would grow without bound towards J = 0, where such a model has no
 * energy to keep it away, and the memory would hold the point there; this way S0 is bounded by |cof F| |P| / least, and
 * a point inside out forgets. Models with a barrier at J = 0 remember everything. */
static sb_real sbi_memory_weight(sb_material_model model, sb_real J)
{
    const sb_real least = (sb_real)0.05;
    if (!(J > 0))
        return 0;
    return J < least && sb_material_allows_inversion(model) ? J / (least * least) : 1 / J;
}

/* s0 = F^-1 P of a relaxing share; 0 where there is none. Fibres of two families, each may be
 * NULL. */
static void sbi_memory_instant(const sb_material *relaxing, const sb_mat3 *f, const sb_vec3 *fibre,
                               const sb_vec3 *second, sb_real s0[6])
{
    static const int row[6] = {0, 1, 2, 0, 1, 0}, column[6] = {0, 1, 2, 1, 2, 2};
    sb_mat3 p = sb_m3_zero(), cofactor = sb_m3_cofactor(*f);
    sb_real weight = sbi_memory_weight(relaxing->model, sb_v3_dot(sb_m3_column(*f, 0), sb_m3_column(cofactor, 0)));
    int finite = weight > 0 && sb_material_stress(relaxing, f, NULL, &p) &&
                 (!fibre || sbi_fibre_stress(relaxing, f, *fibre, &p)) &&
                 (!second || sbi_fibre_stress(relaxing, f, *second, &p));
    if (finite)
        p = sb_m3_tmul(cofactor, p);
    for (int k = 0; k < 6; k++) {
        s0[k] = finite ? (sb_real)0.5 * weight * (p.m[row[k]][column[k]] + p.m[column[k]][row[k]]) : 0;
        finite &= sb_is_finite(s0[k]);
    }
    for (int k = 0; k < 6 && !finite; k++)
        s0[k] = 0;
}

typedef struct sbi_memory_job {
    sbi_assembly *assembly;
    const sb_vec3 *u; /* the end of a step of dt, or NULL */
    sb_real dt;
    int material; /* of the cells in question, or -1 */
} sbi_memory_job;

/* The memory of a cell moves on to the end of a step. */
static void sbi_memory_advance_cell(const sbi_memory_job *job, int e)
{
    sbi_assembly *assembly = job->assembly;
    const sb_domain *domain = assembly->domain;
    int q = domain->points_per_cell, index = assembly->cell_material[e];
    size_t stride = sbi_memory_stride(assembly);
    sb_mat3 f[SBI_CELL_POINTS];
    sbi_cell_deformations(domain, e, job->u, domain->nodes_per_cell, q, f);
    for (int p = 0; p < q; p++) {
        int is_mean = p >= q - domain->mean_points;
        const sb_material *relaxing = assembly->relaxing + 2 * index + is_mean;
        const sb_vec3 *fibre = relaxing->fibre_stiffness > 0 && !is_mean ? assembly->fibres + e : NULL;
        const sb_vec3 *second = fibre && assembly->second_fibres ? assembly->second_fibres + e : NULL;
        sb_real *point = assembly->history + ((size_t)e * (size_t)q + (size_t)p) * stride, s0[6];
        sbi_memory_instant(relaxing, &f[p], fibre, second, s0);
        sbi_prony_advance(assembly->materials + index, job->dt, point, s0, (sb_real(*)[6])(point + 6));
        memcpy(point, s0, sizeof s0);
    }
}

/* H of a cell's points for a step of dt. */
static void sbi_memory_prestress_cell(sbi_assembly *assembly, int e, sb_real dt)
{
    size_t stride = sbi_memory_stride(assembly), q = (size_t)assembly->domain->points_per_cell;
    for (size_t at = (size_t)e * q; at < (size_t)(e + 1) * q; at++) {
        sb_real *point = assembly->history + at * stride;
        sbi_prony_prestress(assembly->materials + assembly->cell_material[e], dt, point,
                            (const sb_real(*)[6])(point + 6), assembly->prestress + 6 * at);
    }
}

static void sbi_memory_chunk(void *user, int chunk)
{
    const sbi_memory_job *job = (const sbi_memory_job *)user;
    sbi_assembly *assembly = job->assembly;
    for (int e = chunk * assembly->chunk_size; e < sbi_assembly_chunk_end(assembly, chunk); e++) {
        int index = assembly->cell_material[e];
        if (sbi_domain_is_free(assembly->domain, e) || assembly->materials[index].prony_count == 0 ||
            (job->material >= 0 && job->material != index))
            continue;
        if (job->u)
            sbi_memory_advance_cell(job, e);
        sbi_memory_prestress_cell(assembly, e, job->u ? 0 : job->dt);
    }
}

static int sbi_memory_run(sbi_assembly *assembly, const sb_vec3 *u, sb_real dt, int material)
{
    sbi_memory_job job = {NULL, NULL, 0, 0};
    if (!assembly->viscous)
        return 0;
    job.assembly = assembly;
    job.u = u;
    job.dt = dt;
    job.material = material;
    sbi_run(assembly->jobs, sbi_memory_chunk, &job, assembly->chunk_count);
    sbi_memory_relax(assembly, u ? 0 : dt);
    return 1;
}

SBI_API int sbi_assembly_begin_step(sbi_assembly *assembly, sb_real dt)
{
    return sbi_memory_run(assembly, NULL, dt, -1);
}

SBI_API int sbi_assembly_end_step(sbi_assembly *assembly, const sb_vec3 *u, sb_real dt)
{
    return sbi_memory_run(assembly, u, dt, -1);
}

SBI_API void sbi_assembly_forget_cell(sbi_assembly *assembly, int cell, const sb_vec3 *u)
{
    sbi_memory_job job = {NULL, NULL, 0, 0};
    if (!assembly->viscous || assembly->materials[assembly->cell_material[cell]].prony_count == 0)
        return;
    job.assembly = assembly;
    job.u = u;
    job.dt = (sb_real)INFINITY;
    sbi_memory_advance_cell(&job, cell);
    sbi_memory_prestress_cell(assembly, cell, 0);
}

SBI_API void sbi_assembly_forget(sbi_assembly *assembly, int material, const sb_vec3 *u)
{
    sbi_memory_run(assembly, u, (sb_real)INFINITY, material);
}
