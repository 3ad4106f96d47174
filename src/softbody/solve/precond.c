/* precond: factors, their application and the object. */
#include <limits.h>
#include <math.h>
#include <string.h>

#include "precond_private.h"
#include "sparse_live.h"

/* ---- memory -------------------------------------------------------------------------------------------- */

SB_API void sb_preconditioner_free(sb_preconditioner *preconditioner)
{
    sb_allocator allocator;
    if (!preconditioner)
        return;
    allocator = preconditioner->owned.allocator;
    sb_direct_free(preconditioner->direct);
    sbi_multigrid_free(preconditioner->multigrid);
    sbi_fsai_free(&allocator, &preconditioner->fsai);
    sbi_owned_free(&preconditioner->owned);
    sbi_free(&allocator, preconditioner);
}

/* ---- application --------------------------------------------------------------------------------------- */

/* And back: R result_i, with what is prescribed by itself. */
SBI_FORCE_INLINE void sbi_precond_leave(const sb_preconditioner *p, const sb_real *r, size_t i, sb_real scale)
{
    const float *turn = p->turns + 12 * i;
    sbi_float4 v = sbi_f4_load(p->result + 4 * i);
    v = sbi_f4_make(sbi_f4_sum(sbi_f4_mul(sbi_f4_load(turn), v)), sbi_f4_sum(sbi_f4_mul(sbi_f4_load(turn + 4), v)),
                    sbi_f4_sum(sbi_f4_mul(sbi_f4_load(turn + 8), v)));
    for (int k = 0; p->fixed[i] && k < 3; k++)
        if (p->fixed[i] >> k & 1)
            SBI_F4(v, k) = (float)(r[3 * i + (size_t)k] * scale) * p->held[4 * i + (size_t)k];
    sbi_f4_store(p->result + 4 * i, v);
}

/* Rows of a chunk: first <= i < the value. */
static int sbi_precond_end(const sb_preconditioner *p, int chunk)
{
    int first = chunk * SBI_ROW_CHUNK;
    return p->row_count - first < SBI_ROW_CHUNK ? p->row_count : first + SBI_ROW_CHUNK;
}

static void sbi_precond_run(const sbi_precond_job *job, sb_task task)
{
    sbi_precond_job mine = *job;
    sbi_run(&job->p->jobs, task, &mine, sbi_row_chunks(job->p->row_count));
}

static void sbi_precond_enter_task(void *user, int chunk)
{
    const sbi_precond_job *job = (const sbi_precond_job *)user;
    sb_preconditioner *p = job->p;
    size_t last = (size_t)sbi_precond_end(p, chunk);
    for (size_t i = (size_t)chunk * SBI_ROW_CHUNK; i < last; i++)
        sbi_f4_store(p->result + 4 * i, sbi_precond_enter(p, job->r, i, (sb_real)job->scale));
}

static void sbi_precond_leave_task(void *user, int chunk)
{
    const sbi_precond_job *job = (const sbi_precond_job *)user;
    size_t last = (size_t)sbi_precond_end(job->p, chunk);
    for (size_t i = (size_t)chunk * SBI_ROW_CHUNK; i < last; i++)
        sbi_precond_leave(job->p, job->r, i, (sb_real)job->scale);
}

static void sbi_precond_blocks_task(void *user, int chunk)
{
    const sbi_precond_job *job = (const sbi_precond_job *)user;
    sb_preconditioner *p = job->p;
    size_t last = (size_t)sbi_precond_end(p, chunk);
    for (size_t i = (size_t)chunk * SBI_ROW_CHUNK; i < last; i++)
        sbi_f4_store(p->result + 4 * i,
                     sbi_f4_rows(sbi_precond_enter(p, job->r, i, (sb_real)job->scale), p->inverse + 12 * i));
}

/* middle = G result */
static void sbi_precond_rows_task(void *user, int chunk)
{
    sb_preconditioner *p = ((const sbi_precond_job *)user)->p;
    sbi_fsai_multiply(&p->fsai, p->result, p->middle, chunk * SBI_ROW_CHUNK, sbi_precond_end(p, chunk));
}

/* result = G^T middle, turned */
static void sbi_precond_columns_task(void *user, int chunk)
{
    sb_preconditioner *p = ((const sbi_precond_job *)user)->p;
    sbi_fsai_multiply_transposed(&p->fsai, p->middle, p->result, chunk * SBI_ROW_CHUNK, sbi_precond_end(p, chunk));
    if (p->turned)
        sbi_precond_leave_task(user, chunk);
}

SBI_API double sbi_precond_power(double size)
{
    int exponent = 0;
    frexp(size, &exponent);
    return ldexp(1, exponent > 1000 ? -1000 : exponent < -1000 ? 1000 : -exponent);
}

/* A row of what the direct solver solves, as sbi_precond_enter but in full precision. */
static void sbi_precond_enter_exact(const sb_preconditioner *p, const sb_real *r, size_t i, sb_real scale)
{
    const float *turn = p->turns + 12 * i;
    sb_real v[3], *out = p->exact + 3 * i;
    for (int k = 0; k < 3; k++)
        v[k] = p->turned && (p->fixed[i] >> k & 1) ? 0 : r[3 * i + (size_t)k] * scale;
    for (int k = 0; k < 3; k++)
        out[k] =
            !p->turned ? v[k] : (sb_real)turn[k] * v[0] + (sb_real)turn[4 + k] * v[1] + (sb_real)turn[8 + k] * v[2];
}

static void sbi_precond_leave_exact(const sb_preconditioner *p, const sb_real *r, size_t i, sb_real scale)
{
    const float *turn = p->turns + 12 * i;
    sb_real *z = p->exact + 3 * i, v0 = z[0], v1 = z[1], v2 = z[2];
    for (int k = 0; k < 3; k++)
        if (p->fixed[i] >> k & 1)
            z[k] = r[3 * i + (size_t)k] * scale * (sb_real)p->held[4 * i + (size_t)k] * (sb_real)p->matrix_scale;
        else
            z[k] = (sb_real)turn[4 * k] * v0 + (sb_real)turn[4 * k + 1] * v1 + (sb_real)turn[4 * k + 2] * v2;
}

/* exact = S (scale r), and the same rounded in result. */
static void sbi_precond_solve_exact(sb_preconditioner *p, const sb_real *r, sb_real scale)
{
    sb_real back = (sb_real)(1 / p->matrix_scale);
    for (size_t i = 0; i < (size_t)p->row_count; i++)
        sbi_precond_enter_exact(p, r, i, scale);
    sb_direct_solve(p->direct, p->exact, p->exact, 1);
    for (size_t i = 0; p->turned && i < (size_t)p->row_count; i++)
        sbi_precond_leave_exact(p, r, i, scale);
    for (size_t i = 0; p->coarse.ready && i < (size_t)p->row_count; i++)
        sbi_f4_store(p->result + 4 * i, sbi_f4_round(p->exact + 3 * i, back));
}

/* z = what was solved exactly */
static void sbi_precond_write_exact(const sb_preconditioner *p, sb_real *z, double scale)
{
    sb_real back = (sb_real)(1 / scale);
    for (size_t k = 0; k < 3 * (size_t)p->row_count; k++)
        z[k] = p->exact[k] * back;
}

static void sbi_precond_write_task(void *user, int chunk)
{
    const sbi_precond_job *job = (const sbi_precond_job *)user;
    const sb_preconditioner *p = job->p;
    sb_real back = (sb_real)(p->matrix_scale / job->scale);
    size_t last = (size_t)sbi_precond_end(p, chunk);
    for (size_t i = (size_t)chunk * SBI_ROW_CHUNK; i < last; i++)
        for (size_t k = 0; k < 3; k++)
            job->z[3 * i + k] = (sb_real)p->result[4 * i + k] * back;
}

/* result = S r of the kinds that work in single precision. */
static void sbi_precond_smooth(sb_preconditioner *p, const sbi_precond_job *job)
{
    if (p->kind == SB_PRECOND_BLOCK_JACOBI) {
        sbi_precond_run(job, sbi_precond_blocks_task);
    } else if (p->kind == SB_PRECOND_FSAI) {
        sbi_precond_run(job, sbi_precond_enter_task);
        sbi_precond_run(job, sbi_precond_rows_task);
        sbi_precond_run(job, sbi_precond_columns_task);
    } else {
        sbi_precond_sweep(job);
    }
    if (p->turned && p->kind != SB_PRECOND_FSAI) /* which turns its rows as it makes them */
        sbi_precond_run(job, sbi_precond_leave_task);
}

static sbi_precond_job sbi_precond_make_job(sb_preconditioner *p, const sb_real *r, sb_real *z, double size)
{
    sbi_precond_job job;
    memset(&job, 0, sizeof job);
    job.p = p;
    job.r = r;
    job.z = z;
    job.scale = sbi_precond_power(size);
    return job;
}

/* result = S r, in full precision with a complete factor */
static void sbi_precond_smooth_any(sb_preconditioner *p, const sbi_precond_job *job)
{
    if (p->kind == SB_PRECOND_CHOLESKY)
        sbi_precond_solve_exact(p, job->r, (sb_real)job->scale);
    else
        sbi_precond_smooth(p, job);
}

SBI_API void sbi_precond_apply(sb_preconditioner *p, const sb_real *r, sb_real *z, double size)
{
    sbi_precond_job job = sbi_precond_make_job(p, r, z, size);
    if (p->kind == SB_PRECOND_NONE) {
        memcpy(z, r, 3 * (size_t)p->row_count * sizeof(sb_real));
        return;
    }
    if (p->kind == SB_PRECOND_MULTIGRID) {
        sbi_multigrid_apply(p->multigrid, r, (sb_real)job.scale, z, (sb_real)(p->matrix_scale / job.scale));
        return;
    }
    sbi_precond_smooth_any(p, &job);
    job.with_result = 1;
    if (p->coarse.ready)
        sbi_precond_correct(&job);
    else if (p->kind == SB_PRECOND_CHOLESKY)
        sbi_precond_write_exact(p, z, job.scale);
    else
        sbi_precond_run(&job, sbi_precond_write_task);
}

SBI_API void sbi_precond_apply_symmetric(sb_preconditioner *p, const sb_real *r, sb_real *z, double size,
                                         sb_real *spare)
{
    sbi_precond_job job = sbi_precond_make_job(p, r, z, size), smooth = job;
    if (!p->coarse.ready) {
        sbi_precond_apply(p, r, z, size);
        return;
    }
    sbi_precond_project(&job, spare);
    smooth.r = spare;
    sbi_precond_smooth_any(p, &smooth);
    job.with_result = 1;
    sbi_precond_correct(&job);
}

SBI_API int sbi_precond_has_coarse(const sb_preconditioner *p) { return p->coarse.ready; }

SBI_API void sbi_precond_apply_smoother(sb_preconditioner *p, const sb_real *r, sb_real *z, double size)
{
    sbi_precond_job job = sbi_precond_make_job(p, r, z, size);
    sbi_precond_smooth_any(p, &job);
    sbi_precond_run(&job, sbi_precond_write_task);
}

SBI_API void sbi_precond_apply_coarse(sb_preconditioner *p, const sb_real *y, sb_real *z, double size)
{
    sbi_precond_job job = sbi_precond_make_job(p, y, z, size);
    job.with_result = 1;
    sbi_precond_correct(&job);
}

SBI_API int sbi_precond_coarse_solve(sb_preconditioner *p, const sb_real *r, sb_real *z, double size)
{
    sbi_precond_job job = sbi_precond_make_job(p, r, z, size);
    if (!p->coarse.ready)
        return 0;
    memset(p->result, 0, (size_t)p->row_count * 4 * sizeof(float));
    sbi_precond_correct(&job);
    return 1;
}

SB_API void sb_preconditioner_apply(sb_preconditioner *preconditioner, const sb_real *r, sb_real *z)
{
    sb_real largest = 0;
    if (!preconditioner || !r || !z)
        return;
    for (size_t k = 0; k < 3 * (size_t)preconditioner->row_count; k++) {
        sb_real size = r[k] < 0 ? -r[k] : r[k];
        largest = size > largest ? size : largest;
    }
    sbi_precond_apply(preconditioner, r, z, (double)largest);
}

/* ---- life ---------------------------------------------------------------------------------------------- */

SB_API sb_preconditioner_def sb_default_preconditioner_def(void)
{
    sb_preconditioner_def def;
    memset(&def, 0, sizeof def);
    def.kind = SB_PRECOND_AUTO;
    def.piece_count = SB_PRECOND_PIECES_AUTO;
    def.power = 1;
    return def;
}

SB_API sb_precond_kind sb_solver_auto(const sb_matrix *pattern)
{
    return pattern && sbi_matrix_used_blocks(pattern) >= SBI_PRECOND_MULTIGRID_BLOCKS ? SB_PRECOND_MULTIGRID
                                                                                      : SB_PRECOND_IC0;
}

SB_API const char *sb_precond_string(sb_precond_kind kind)
{
    switch (kind) {
    case SB_PRECOND_NONE: return "none";
    case SB_PRECOND_BLOCK_JACOBI: return "block Jacobi";
    case SB_PRECOND_SSOR: return "SSOR";
    case SB_PRECOND_IC0: return "incomplete Cholesky";
    case SB_PRECOND_AUTO: return "automatic";
    case SB_PRECOND_FSAI: return "sparse approximate inverse";
    case SB_PRECOND_CHOLESKY: return "complete Cholesky";
    case SB_PRECOND_MULTIGRID: return "multigrid";
    default: return "unknown";
    }
}

static int sbi_precond_pieces(const sb_preconditioner *p, int rows)
{
    int pieces = rows / SBI_PRECOND_NODES_PER_PIECE;
    if (!p->rest || p->kind == SB_PRECOND_NONE || p->kind == SB_PRECOND_MULTIGRID)
        return 0;
    if (p->wanted_pieces != SB_PRECOND_PIECES_AUTO)
        return p->wanted_pieces;
    if (p->kind == SB_PRECOND_CHOLESKY) /* it leaves nothing to smooth */
        return 0;
    return pieces < SBI_PRECOND_MAX_PIECES ? pieces : SBI_PRECOND_MAX_PIECES;
}

SBI_API int sbi_precond_wanted_pieces(const sb_preconditioner *p) { return sbi_precond_pieces(p, p->row_count); }

static sb_result sbi_precond_check_young(int cell_count, const sb_real *young, sb_error *error)
{
    for (int e = 0; e < cell_count; e++) {
        if (!sb_is_finite(young[e]))
            return sbi_fail_element(error, SB_ERROR_NOT_FINITE, e, "element %d: the modulus is not finite", e);
        if (young[e] < 0)
            return sbi_fail_element(error, SB_ERROR_ARGUMENT, e, "element %d: the modulus is negative", e);
    }
    return SB_OK;
}

SB_API sb_result sb_preconditioner_moduli(const sb_matrix *pattern, int cell_count, int nodes_per_cell,
                                          const int *cells, const sb_real *young, sb_real *moduli, sb_error *error)
{
    sb_result result;
    if (!pattern || cell_count < 0 || nodes_per_cell < 1 || !moduli || (cell_count > 0 && (!cells || !young)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "moduli need a matrix, cells and a place");
    result = sbi_precond_check_young(cell_count, young, error);
    if (result != SB_OK)
        return result;
    memset(moduli, 0, (size_t)pattern->block_count * sizeof *moduli);
    for (int e = 0; e < cell_count; e++) {
        const int *cell = cells + (size_t)e * (size_t)nodes_per_cell;
        for (int a = 0; a < nodes_per_cell; a++)
            for (int b = 0; b < nodes_per_cell; b++) {
                int q = sb_matrix_find(pattern, cell[a], cell[b]);
                if (q < 0)
                    return sbi_fail_element(error, SB_ERROR_INDEX, e,
                                            "element %d: the pattern has no block for nodes %d and %d", e, cell[a],
                                            cell[b]);
                if (young[e] > moduli[q])
                    moduli[q] = young[e];
            }
    }
    return SB_OK;
}

static sb_result sbi_precond_check(const sb_preconditioner_def *def, const sb_matrix *pattern, sb_error *error)
{
    if (!def || !pattern || pattern->row_count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a preconditioner needs a def and a matrix");
    if ((int)def->kind < SB_PRECOND_NONE || (int)def->kind > SB_PRECOND_MULTIGRID)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "unknown preconditioner kind %d", (int)def->kind);
    if (def->power < 1 || def->power > SB_PRECOND_MAX_POWER)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "power %d is outside 1 to %d", def->power, SB_PRECOND_MAX_POWER);
    if (def->piece_count < SB_PRECOND_PIECES_AUTO || def->piece_count > pattern->row_count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "piece_count %d is outside 0 to %d", def->piece_count,
                        pattern->row_count);
    if (!(def->poisson >= -1 && def->poisson <= (sb_real)0.5))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "poisson %g is outside -1 to 0.5", (double)def->poisson);
    if (def->kind == SB_PRECOND_MULTIGRID && !def->positions)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "multigrid needs the positions of the nodes");
    for (int q = 0; def->moduli && q < pattern->block_count; q++)
        if (!sb_is_finite(def->moduli[q]))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "moduli[%d] is not finite", q);
    for (int q = 0; def->moduli && q < pattern->block_count; q++)
        if (def->moduli[q] < 0)
            return sbi_fail(error, SB_ERROR_ARGUMENT, "moduli[%d] is negative", q);
    if (def->level_count < 0 || (def->level_count > 0 && !def->levels))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "level_count %d does not fit levels", def->level_count);
    for (int i = 0; def->positions && i < pattern->row_count; i++)
        if (!sb_v3_is_finite(def->positions[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "node %d: position is not finite", i);
    return SB_OK;
}

static sb_result sbi_precond_make_direct(sb_preconditioner *p, const sb_preconditioner_def *def, const sb_matrix *a)
{
    sb_direct_def settings = sb_default_direct_def();
    sb_result result;
    settings.positions = def->positions;
    p->exact = (sb_real *)sbi_owned_take(&p->owned, (size_t)a->row_count, 3 * sizeof(sb_real));
    if (!p->exact)
        return SB_ERROR_MEMORY;
    result = sb_direct_create(&settings, a, &p->owned.allocator, &p->direct, NULL);
    if (result == SB_OK)
        p->owned.bytes += sb_direct_get_info(p->direct).bytes;
    return result;
}

/* What only one kind needs. */
static sb_result sbi_precond_make_kind(sb_preconditioner *p, const sb_preconditioner_def *def, const sb_matrix *a,
                                       int pieces)
{
    sb_result result = SB_OK;
    if (p->kind == SB_PRECOND_FSAI) {
        result = sbi_fsai_create(a, def->power, &p->owned.allocator, &p->fsai);
        p->owned.bytes += p->fsai.bytes;
    } else if (p->kind == SB_PRECOND_CHOLESKY) {
        result = sbi_precond_make_direct(p, def, a);
    } else {
        p->inverse = sbi_owned_take_floats(&p->owned, (size_t)sbi_matrix_row_capacity(a), 12);
        if (!p->inverse)
            result = SB_ERROR_MEMORY;
    }
    if (result == SB_OK && (p->kind == SB_PRECOND_SSOR || p->kind == SB_PRECOND_IC0) &&
        !sbi_precond_make_lower(p, a, p->kind == SB_PRECOND_IC0 && pieces > 0))
        result = SB_ERROR_MEMORY;
    return result;
}

/* Whether what this kind has of the pattern follows; kinds that do not are made anew. */
static int sbi_precond_kind_follows(sb_precond_kind kind)
{
    return kind == SB_PRECOND_NONE || kind == SB_PRECOND_BLOCK_JACOBI || kind == SB_PRECOND_SSOR ||
           kind == SB_PRECOND_IC0;
}

/* Scratch for the patterns to come of a matrix that follows; 0: no memory. */
static int sbi_precond_take_following(sb_preconditioner *p, const sb_matrix *a)
{
    int times; /* as many rows as there are may come; where they are copies, rows grow with them */
    if (!a->live || !sbi_precond_kind_follows(p->kind))
        return 1;
    p->row_room = sbi_matrix_row_capacity(a);
    p->block_room = sbi_matrix_capacity(a);
    times = a->row_count > 0 ? 1 + (p->row_room - 1) / a->row_count : 1;
    if (times > INT_MAX / 16 / (2 * a->live->longest + SBI_LIVE_PIECE))
        return 0;
    p->longest_room = times * (2 * a->live->longest + SBI_LIVE_PIECE);
    if (p->row_room > INT_MAX / 16 || p->block_room > INT_MAX / 2)
        return 0;
    p->scratch = sbi_owned_take_ints(&p->owned, 8 * (size_t)p->row_room + (size_t)p->block_room + 1);
    p->centres = (sb_vec3 *)sbi_owned_take(&p->owned, (size_t)p->row_room, sizeof(sb_vec3));
    return p->scratch && p->centres;
}

/* The pieces, once the smoother is there; 0: no memory. */
static int sbi_precond_make_any_coarse(sb_preconditioner *p, const sb_matrix *a, int pieces)
{
    int most = p->row_room ? sbi_precond_pieces(p, p->row_room) : pieces;
    if (most == 0)
        return 1;
    if (!p->row_room)
        return sbi_precond_make_coarse(p, a, p->rest, pieces);
    if (!sbi_precond_take_coarse(p, most))
        return 0;
    sbi_precond_shape_coarse(p, a, pieces, 1);
    return 1;
}

static sb_result sbi_precond_make_smoother(sb_preconditioner *p, const sb_preconditioner_def *def, const sb_matrix *a,
                                           sb_error *error)
{
    size_t rows = (size_t)sbi_matrix_row_capacity(a);
    int pieces = sbi_precond_pieces(p, a->row_count);
    sb_result result = SB_OK;
    p->middle = sbi_owned_take_floats(&p->owned, rows, 4);
    p->result = sbi_owned_take_floats(&p->owned, rows, 4);
    p->turns = sbi_owned_take_floats(&p->owned, rows, 12);
    p->held = sbi_owned_take_floats(&p->owned, rows, 4);
    p->fixed = (unsigned char *)sbi_owned_take(&p->owned, rows, 1);
    if (!p->middle || !p->result || !p->turns || !p->held || !p->fixed || !sbi_precond_take_following(p, a))
        result = SB_ERROR_MEMORY;
    if (result == SB_OK)
        result = sbi_precond_make_kind(p, def, a, pieces);
    if (result == SB_OK && !sbi_precond_make_any_coarse(p, a, pieces))
        result = SB_ERROR_MEMORY;
    if (result != SB_OK)
        return sbi_fail(error, result, "no memory for a preconditioner of %d rows", a->row_count);
    return SB_OK;
}

static sb_result sbi_precond_make_multigrid(sb_preconditioner *p, const sb_preconditioner_def *def,
                                            const sb_matrix *pattern, const sb_preconditioner *like, sb_error *error)
{
    sbi_multigrid_setup setup;
    sb_result result;
    setup.positions = def->positions;
    setup.moduli = def->moduli;
    setup.levels = def->levels;
    setup.level_count = def->level_count;
    setup.like = like ? like->multigrid : NULL;
    setup.jobs = def->jobs;
    result = sbi_multigrid_create(&setup, pattern, &p->owned.allocator, &p->multigrid, error);
    if (result != SB_OK)
        return result;
    p->owned.bytes += sbi_multigrid_bytes(p->multigrid);
    if (!like)
        sbi_multigrid_set_poisson(p->multigrid, (double)def->poisson);
    return SB_OK;
}

static sb_precond_kind sbi_precond_resolve(const sb_preconditioner_def *def, const sb_matrix *pattern)
{
    if (def->kind != SB_PRECOND_AUTO)
        return def->kind;
    return def->positions ? sb_solver_auto(pattern) : SB_PRECOND_IC0;
}

static uint64_t sbi_precond_hash_pattern(const sb_matrix *a)
{
    uint64_t hash = (uint64_t)(unsigned)a->row_count;
    unsigned blocks = 0;
    for (int i = 0; i < a->row_count; i++) {
        blocks += (unsigned)(a->row_end[i] - a->row_start[i]);
        hash = sbi_hash_word(hash, (uint64_t)blocks);
    }
    for (int i = 0; i < a->row_count; i++)
        for (int q = a->row_start[i]; q < a->row_end[i]; q++)
            hash = sbi_hash_word(hash, (uint64_t)(unsigned)a->columns[q]);
    return hash;
}

static sb_result sbi_precond_create(const sb_preconditioner_def *def, const sb_matrix *pattern,
                                    const sb_preconditioner *like, const sb_allocator *allocator,
                                    sb_preconditioner **out, sb_error *error)
{
    sb_preconditioner *p;
    sb_result result = sbi_precond_check(def, pattern, error);
    if (result != SB_OK)
        return result;
    if (!out)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_preconditioner_create needs a place for its result");
    p = (sb_preconditioner *)sbi_alloc_zeroed(allocator, 1, sizeof *p);
    if (!p)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a preconditioner");
    if (allocator)
        p->owned.allocator = *allocator;
    p->jobs = def->jobs;
    p->power = def->power;
    p->owned.bytes = sizeof *p;
    p->kind = sbi_precond_resolve(def, pattern);
    p->rest = def->positions;
    p->wanted_pieces = def->piece_count;
    p->row_count = pattern->row_count;
    p->block_count = sbi_matrix_used_blocks(pattern);
    p->lower_count = (p->block_count - pattern->row_count) / 2;
    p->pattern_version = sbi_matrix_version(pattern);
    if (p->kind != SB_PRECOND_MULTIGRID) /* which is never saved */
        p->pattern_hash = sbi_precond_hash_pattern(pattern);
    p->wait = SBI_PRECOND_RELAX_FIRST;
    p->matrix_scale = 1;
    if (p->kind == SB_PRECOND_MULTIGRID)
        result = sbi_precond_make_multigrid(p, def, pattern, like, error);
    else if (p->kind != SB_PRECOND_NONE)
        result = sbi_precond_make_smoother(p, def, pattern, error);
    if (result != SB_OK) {
        sb_preconditioner_free(p);
        return result;
    }
    *out = p;
    return SB_OK;
}

SB_API sb_result sb_preconditioner_create(const sb_preconditioner_def *def, const sb_matrix *pattern,
                                          const sb_allocator *allocator, sb_preconditioner **out, sb_error *error)
{
    return sbi_precond_create(def, pattern, NULL, allocator, out, error);
}

SBI_API sb_result sbi_precond_remake(const sb_preconditioner *like, const sb_matrix *pattern, const sb_vec3 *positions,
                                     const sb_real *moduli, const sb_allocator *allocator, sb_preconditioner **out,
                                     sb_error *error)
{
    sb_preconditioner_def def = sb_default_preconditioner_def();
    def.kind = like->kind;
    def.positions = positions;
    def.moduli = moduli;
    def.jobs = like->jobs;
    def.power = like->power;
    return sbi_precond_create(&def, pattern, like, allocator, out, error);
}

/* ---- patterns that change -------------------------------------------------------------------------------- */

SBI_API int sbi_precond_reserve(const sb_preconditioner *p, const sb_matrix *matrix)
{
    return p->kind == SB_PRECOND_NONE || !sbi_precond_kind_follows(p->kind) ||
           (sbi_matrix_row_capacity(matrix) <= p->row_room && sbi_matrix_capacity(matrix) <= p->block_room &&
            matrix->live->longest <= p->longest_room);
}

SBI_API int sbi_precond_follows(const sb_preconditioner *p) { return sbi_precond_kind_follows(p->kind); }

SBI_API void sbi_precond_follow(sb_preconditioner *p, const sb_matrix *matrix, const sb_vec3 *rest)
{
    p->ready = p->turned = 0;
    p->coarse.ready = 0;
    p->recut = 1;
    p->stale |= !sbi_precond_kind_follows(p->kind) || p->pattern_version != sbi_matrix_version(matrix);
    if (!sbi_precond_kind_follows(p->kind))
        return;
    p->row_count = matrix->row_count;
    p->block_count = sbi_matrix_used_blocks(matrix);
    p->lower_count = (p->block_count - p->row_count) / 2;
    p->pattern_version = sbi_matrix_version(matrix);
    p->rest = rest;
    p->pattern_hash = 0; /* for images of a factor, which nobody makes of these */
}

SBI_API int sbi_precond_settle(sb_preconditioner *p, const sb_matrix *matrix)
{
    int pieces = sbi_precond_pieces(p, p->row_count), stale = p->stale;
    if (!stale && !p->recut)
        return 1;
    if (!sbi_precond_kind_follows(p->kind))
        return 0;
    p->stale = p->recut = 0;
    if (stale && (p->kind == SB_PRECOND_SSOR || p->kind == SB_PRECOND_IC0))
        sbi_precond_shape_lower(p, matrix, p->kind == SB_PRECOND_IC0 && pieces > 0);
    if (p->coarse.piece_room)
        sbi_precond_shape_coarse(p, matrix, pieces, stale);
    return 1;
}

/* ---- update -------------------------------------------------------------------------------------------- */

/* *scale: the mean of its diagonal. */
static sb_result sbi_precond_check_matrix(const sb_preconditioner *p, const sb_matrix *matrix, const sb_vec3 *positions,
                                          double *scale, sb_error *error)
{
    if (!p || !matrix || matrix->row_count != p->row_count || sbi_matrix_used_blocks(matrix) != p->block_count ||
        sbi_matrix_version(matrix) != p->pattern_version)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the matrix does not have the preconditioner's pattern");
    *scale = (double)sbi_matrix_diagonal_scale(matrix, NULL, &p->jobs);
    if (!(*scale - *scale == 0))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the matrix has a diagonal entry that is not finite");
    for (int i = 0; positions && p->coarse.piece_count && i < p->row_count; i++)
        if (!sb_v3_is_finite(positions[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "node %d: position is not finite", i);
    return SB_OK;
}

static sb_result sbi_precond_update_fsai(sb_preconditioner *p, const sb_matrix *a, sb_error *error)
{
    int bad = sbi_fsai_update(&p->fsai, a, p->matrix_scale, (double)SBI_PRECOND_MAX_SHIFT, &p->jobs, &p->shift);
    if (bad >= 0)
        return sbi_fail_node(error, SB_ERROR_INDEFINITE, bad,
                             "node %d: no factor of its row's matrix up to a shift "
                             "of %g",
                             bad, (double)SBI_PRECOND_MAX_SHIFT);
    return SB_OK;
}

/* An update as tasks. */
typedef struct sbi_precond_updating {
    sb_preconditioner *p;
    const sb_matrix *matrix;
    sb_error *error;
    sb_result result;
} sbi_precond_updating;

static void sbi_precond_half_task(void *user, int half)
{
    const sbi_precond_updating *work = (const sbi_precond_updating *)user;
    sbi_precond_factor_half(work->p, work->matrix, half);
}

static void sbi_precond_between_task(void *user, int index)
{
    sbi_precond_updating *work = (sbi_precond_updating *)user;
    (void)index;
    work->result = sbi_precond_end_ic0(work->p, work->matrix, work->error);
}

/* All of the smoother of other kinds than IC(0). */
static void sbi_precond_whole_task(void *user, int index)
{
    sbi_precond_updating *work = (sbi_precond_updating *)user;
    sb_preconditioner *p = work->p;
    int bad = -1;
    (void)index;
    if (p->kind == SB_PRECOND_FSAI)
        work->result = sbi_precond_update_fsai(p, work->matrix, work->error);
    if (p->kind == SB_PRECOND_CHOLESKY)
        work->result = sb_direct_update(p->direct, work->matrix, work->error);
    if (p->kind == SB_PRECOND_BLOCK_JACOBI || p->kind == SB_PRECOND_SSOR)
        bad = sbi_precond_invert_diagonals(p, work->matrix);
    if (p->kind == SB_PRECOND_MULTIGRID)
        bad = sbi_multigrid_update(p->multigrid, work->matrix, p->matrix_scale);
    if (bad >= 0)
        work->result = sbi_fail_node(work->error, SB_ERROR_INDEFINITE, bad,
                                     "node %d: diagonal block is not positive definite", bad);
    else if (p->kind == SB_PRECOND_SSOR)
        sbi_precond_fill_ssor(p, work->matrix);
}

/* The smoother and, beside it where it leaves threads, the pieces. */
static void sbi_precond_update_all(sbi_precond_updating *work, const sb_vec3 *positions)
{
    sb_preconditioner *p = work->p;
    sbi_precond_beside beside;
    beside.user = work;
    beside.count = p->kind == SB_PRECOND_IC0 ? sbi_precond_begin_ic0(p) : 1;
    beside.task = p->kind == SB_PRECOND_IC0 ? sbi_precond_half_task : sbi_precond_whole_task;
    beside.last = p->kind == SB_PRECOND_IC0 ? sbi_precond_between_task : NULL;
    if (p->coarse.piece_count && p->kind != SB_PRECOND_FSAI) { /* which shares itself out */
        sbi_precond_update_coarse(p, work->matrix, positions, &beside);
        return;
    }
    sbi_run(&p->jobs, beside.task, work, beside.count);
    if (beside.last)
        beside.last(work, 0);
    if (work->result == SB_OK && p->coarse.piece_count)
        sbi_precond_update_coarse(p, work->matrix, positions, NULL);
}

SB_API sb_result sb_preconditioner_update(sb_preconditioner *p, const sb_matrix *matrix, const sb_vec3 *positions,
                                          sb_error *error)
{
    sbi_precond_updating work;
    double scale = 1;
    work.result = sbi_precond_check_matrix(p, matrix, positions, &scale, error);
    if (work.result != SB_OK)
        return work.result;
    (void)sbi_precond_settle(p, matrix); /* what cannot has not the matrix' pattern */
    p->matrix_scale = sbi_precond_power(scale);
    p->attempts = 0;
    p->ready = 0;
    p->turned = 0;
    work.p = p;
    work.matrix = matrix;
    work.error = error;
    sbi_precond_update_all(&work, positions);
    p->ready = work.result == SB_OK;
    return work.result;
}

/* ---- warping ------------------------------------------------------------------------------------------- */

/* 1 when q is near enough to a unit quaternion to be meant as one. */
static int sbi_precond_is_rotation(sb_quat q)
{
    sb_real square = sb_quat_dot(q, q);
    return square > (sb_real)0.98 && square < (sb_real)1.02;
}

static sb_result sbi_precond_check_rotations(const sb_preconditioner *p, const sb_quat *rotations, sb_error *error)
{
    for (int i = 0; rotations && i < p->row_count; i++)
        if (!sbi_precond_is_rotation(rotations[i]))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "node %d: rotation is not a unit quaternion", i);
    return SB_OK;
}

static void sbi_precond_turn(sb_preconditioner *p, const sb_matrix *a, const sb_quat *rotations)
{
    for (size_t i = 0; i < (size_t)p->row_count; i++) {
        sb_mat3 r = sb_quat_to_mat3(sb_quat_normalise(rotations[i]));
        const sb_real *diagonal = a->blocks[a->diagonal[i]];
        for (size_t k = 0; k < 3; k++) {
            double entry = (double)diagonal[4 * k] * p->matrix_scale;
            sbi_f4_store(p->turns + 12 * i + 4 * k, sbi_f4_make((float)r.m[k][0], (float)r.m[k][1], (float)r.m[k][2]));
            p->held[4 * i + k] = (a->fixed[i] >> k & 1) && entry > 0 ? (float)(1 / entry) : 0;
        }
        p->held[4 * i + 3] = 0;
        p->fixed[i] = a->fixed[i];
    }
}

SB_API sb_result sb_preconditioner_warp(sb_preconditioner *p, const sb_matrix *matrix, const sb_quat *rotations,
                                        const sb_vec3 *positions, sb_error *error)
{
    double scale;
    sb_result result = sbi_precond_check_matrix(p, matrix, positions, &scale, error);
    if (result == SB_OK && p->kind == SB_PRECOND_MULTIGRID)
        result = sbi_fail(error, SB_ERROR_UNSUPPORTED, "multigrid is not turned, but updated");
    if (result == SB_OK && !p->ready)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "there is nothing to turn: the preconditioner was never updated");
    if (result == SB_OK)
        result = sbi_precond_check_rotations(p, rotations, error);
    if (result != SB_OK || p->kind == SB_PRECOND_NONE)
        return result;
    p->turned = rotations != NULL;
    if (rotations)
        sbi_precond_turn(p, matrix, rotations);
    if (p->coarse.piece_count)
        sbi_precond_update_coarse(p, matrix, positions, NULL);
    return SB_OK;
}

SBI_API int sbi_precond_soften(sb_preconditioner *preconditioner)
{
    return preconditioner->multigrid && sbi_multigrid_soften(preconditioner->multigrid);
}

SBI_API sbi_multigrid *sbi_precond_compact(const sb_preconditioner *preconditioner)
{
    sbi_multigrid *multigrid = preconditioner->ready ? preconditioner->multigrid : NULL;
    return multigrid && sbi_multigrid_deviation(multigrid) > 0 ? multigrid : NULL;
}

SBI_API void sbi_precond_set_poisson(sb_preconditioner *preconditioner, sb_real poisson)
{
    if (preconditioner->multigrid)
        sbi_multigrid_set_poisson(preconditioner->multigrid, (double)poisson);
}

SBI_API int sbi_precond_couples_parts(const sb_preconditioner *preconditioner)
{
    return preconditioner->multigrid && sbi_multigrid_couples_parts(preconditioner->multigrid);
}

SBI_API int sbi_precond_rows(const sb_preconditioner *preconditioner) { return preconditioner->row_count; }

SBI_API sbi_precond_memory sbi_precond_get_memory(const sb_preconditioner *preconditioner)
{
    sbi_precond_memory memory;
    memory.shift = preconditioner->shift;
    memory.successes = preconditioner->successes;
    memory.wait = preconditioner->wait;
    if (preconditioner->multigrid) {
        sbi_mg_reach reach = sbi_multigrid_get_reach(preconditioner->multigrid);
        memory.shift = reach.deviations;
        memory.successes = reach.age;
    }
    return memory;
}

SBI_API void sbi_precond_set_memory(sb_preconditioner *preconditioner, sbi_precond_memory memory)
{
    preconditioner->wait = memory.wait;
    if (preconditioner->multigrid) {
        sbi_mg_reach reach;
        reach.deviations = memory.shift < SBI_MG_MAX_REACH ? memory.shift : 0;
        reach.age = memory.successes;
        sbi_multigrid_set_reach(preconditioner->multigrid, reach);
        return;
    }
    preconditioner->shift = memory.shift;
    preconditioner->successes = memory.successes;
}

SBI_API void sbi_precond_forget(sb_preconditioner *preconditioner)
{
    sbi_precond_memory memory = {0, 0, SBI_PRECOND_RELAX_FIRST};
    sbi_precond_set_memory(preconditioner, memory);
}

SBI_API int sbi_precond_is_memory(sbi_precond_memory memory)
{
    return memory.shift >= 0 && memory.shift <= 2 * (double)SBI_PRECOND_MAX_SHIFT && memory.successes >= 0 &&
           memory.wait >= SBI_PRECOND_RELAX_FIRST && memory.wait <= SBI_PRECOND_RELAX_LAST;
}

SB_API sb_preconditioner_info sb_preconditioner_get_info(const sb_preconditioner *preconditioner)
{
    sb_preconditioner_info none;
    sb_preconditioner_info info;
    if (!preconditioner) {
        memset(&none, 0, sizeof none);
        return none;
    }
    info.kind = preconditioner->kind;
    info.piece_count = preconditioner->coarse.piece_count;
    info.attempts = preconditioner->attempts;
    info.shift = preconditioner->shift;
    info.level_count = preconditioner->multigrid ? sbi_multigrid_levels(preconditioner->multigrid) : 0;
    info.bytes = preconditioner->owned.bytes;
    return info;
}
