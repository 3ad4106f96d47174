/* body_pattern: the matrix with couplings beyond the elements, and its preconditioner. */
#include "body.h"
#include "body_private.h"
#include "../fem/assembly_patch.h"
#include "live_private.h"
#include "rigid_private.h"

#include <string.h>

/* ---- couplings beyond the elements ---- */

/* 1 when the pattern has a block for every pair of the nodes. */
static int sbi_body_row_fits(const sb_body *body, const int *nodes, int count)
{
    for (int a = 0; a < count; a++)
        for (int b = 0; b < count; b++)
            if (sb_matrix_find(&body->matrix, nodes[a], nodes[b]) < 0)
                return 0;
    return 1;
}

/* The body's rows so far and, after them, those of the new ones that do not fit. Counts only when pattern has no
 * arrays yet; *entries is the number of their nodes. */
static void sbi_body_list_extra(const sb_body *body, int cell_count, const int *cell_start, const int *cells,
                                sbi_body_pattern *pattern, size_t *entries)
{
    int count = body->extra_count;
    size_t used = count ? (size_t)body->extra_start[count] : 0;
    if (pattern->extra_start && count) {
        memcpy(pattern->extra_start, body->extra_start, ((size_t)count + 1) * sizeof(int));
        memcpy(pattern->extra_nodes, body->extra_nodes, used * sizeof(int));
    }
    for (int c = 0; c < cell_count; c++) {
        int size = cell_start[c + 1] - cell_start[c];
        if (sbi_body_row_fits(body, cells + cell_start[c], size))
            continue;
        if (pattern->extra_start) {
            pattern->extra_start[count] = (int)used;
            memcpy(pattern->extra_nodes + used, cells + cell_start[c], (size_t)size * sizeof(int));
            pattern->extra_start[count + 1] = (int)(used + (size_t)size);
        }
        used += (size_t)size;
        count++;
    }
    pattern->extra_count = count;
    *entries = used;
}

static sb_result sbi_body_make_extra(const sb_body *body, int cell_count, const int *cell_start, const int *cells,
                                     sbi_body_pattern *pattern, sb_error *error)
{
    size_t entries, bytes = 0;
    sbi_body_list_extra(body, cell_count, cell_start, cells, pattern, &entries);
    pattern->needed = pattern->extra_count > body->extra_count;
    if (!pattern->needed)
        return SB_OK;
    if (entries <= INT32_MAX && sbi_size_add(&bytes, (size_t)pattern->extra_count + 1, sizeof(int)) &&
        sbi_size_add(&bytes, entries, sizeof(int)))
        pattern->extra_start = (int *)sbi_alloc(&body->allocator, bytes, 1);
    if (!pattern->extra_start)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d coupling rows", pattern->extra_count);
    pattern->extra_nodes = pattern->extra_start + pattern->extra_count + 1;
    sbi_body_list_extra(body, cell_count, cell_start, cells, pattern, &entries);
    return SB_OK;
}

/* Ties that are rows of the matrix's pattern: a body that follows changes has its couplings by itself. */
static int sbi_body_tie_rows(const sb_body *body)
{
    return body->live && !body->live->follows ? body->live->glue.count : 0;
}

/* Patches of elements are rows of it, too. */
static int sbi_body_patch_rows(const sb_body *body)
{
    return body->assembly.patches ? body->assembly.patches->count : 0;
}

/* The matrix of elements, ties, patches and extra rows together. */
static sb_result sbi_body_make_extended_matrix(const sb_body *body, int extra_count, const int *extra_start,
                                               const int *extra_nodes, sb_matrix *matrix, sb_error *error)
{
    const sb_domain *domain = &body->domain;
    const sbi_patches *patches = body->assembly.patches;
    int ties = sbi_body_tie_rows(body), patch_rows = sbi_body_patch_rows(body);
    int first = domain->cell_count + ties + patch_rows;
    size_t n = (size_t)domain->nodes_per_cell, tied = (size_t)(domain->cell_count + 2 * ties) * n, bytes = 0;
    size_t own = tied + (patch_rows ? (size_t)patches->node_start[patch_rows] : 0);
    size_t extra = extra_count ? (size_t)extra_start[extra_count] : 0, cells = (size_t)first + (size_t)extra_count;
    int *start = NULL, *nodes;
    sb_result result;
    if (own + extra <= INT32_MAX && cells < INT32_MAX && sbi_size_add(&bytes, cells + 1, sizeof(int)) &&
        sbi_size_add(&bytes, own + extra, sizeof(int)))
        start = (int *)sbi_alloc(&body->allocator, bytes, 1);
    if (!start)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the couplings of %d rows", extra_count);
    nodes = start + cells + 1;
    for (int e = 0; e < domain->cell_count; e++)
        start[e] = e * domain->nodes_per_cell;
    memcpy(nodes, domain->cells, (size_t)domain->cell_count * n * sizeof(int));
    for (int k = 0; k < ties; k++) {
        int at = (domain->cell_count + 2 * k) * domain->nodes_per_cell;
        start[domain->cell_count + k] = at;
        memcpy(nodes + at, body->live->glue.ties[k].nodes[0], n * sizeof(int));
        memcpy(nodes + (size_t)at + n, body->live->glue.ties[k].nodes[1], n * sizeof(int));
    }
    for (int k = 0; k < patch_rows; k++)
        start[domain->cell_count + ties + k] = (int)tied + patches->node_start[k];
    if (patch_rows)
        memcpy(nodes + tied, patches->nodes, (own - tied) * sizeof(int));
    for (int c = 0; c < extra_count; c++)
        start[first + c] = (int)own + extra_start[c];
    start[cells] = (int)(own + extra);
    if (extra)
        memcpy(nodes + own, extra_nodes, extra * sizeof(int));
    result = sb_matrix_create(domain->node_count, (int)cells, 0, start, nodes, &body->allocator, matrix, error);
    sbi_free(&body->allocator, start);
    return result;
}

SBI_API sb_result sbi_body_make_matrix(const sb_body *body, int extra_count, const int *extra_start,
                                       const int *extra_nodes, sb_matrix *matrix, sb_error *error)
{
    const sb_domain *domain = &body->domain;
    sb_result result = extra_count || sbi_body_tie_rows(body) || sbi_body_patch_rows(body)
                           ? sbi_body_make_extended_matrix(body, extra_count, extra_start, extra_nodes, matrix, error)
                           : sb_matrix_create(domain->node_count, domain->cell_count, domain->nodes_per_cell, NULL,
                                              domain->cells, &body->allocator, matrix, error);
    return result == SB_OK ? sbi_live_make_matrix(body, matrix, error) : result;
}

/* Takes the arrays of one entry per block from the arena (measuring or for real). */
static void sbi_body_pattern_layout(const sb_body *body, sbi_body_pattern *pattern, sbi_arena *arena)
{
    size_t blocks = (size_t)sbi_matrix_capacity(&pattern->matrix);
    if (body->mass_blocks)
        pattern->mass_blocks = (sb_real *)sbi_arena_take(arena, blocks, sizeof(sb_real));
    if (sbi_assembly_has_pairs(&body->assembly))
        pattern->pair_start = (int *)sbi_arena_take(arena, blocks + 1, sizeof(int));
}

static sb_result sbi_body_make_block_arrays(const sb_body *body, const unsigned char *fixed, sbi_body_pattern *pattern,
                                            sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    int most = sbi_matrix_capacity(&pattern->matrix);
    const int *row_start = pattern->matrix.row_start, *row_end = pattern->matrix.row_end;
    sbi_body_pattern_layout(body, pattern, &arena);
    pattern->memory = arena.overflow ? NULL : sbi_alloc(&body->allocator, arena.used, 1);
    for (int i = 0; i < body->domain.node_count; i++)
        if (fixed[i] && body->node_component[i] >= 0)
            pattern->support_used += row_end[i] - row_start[i];
    pattern->support_capacity = body->support_capacity;
    if (pattern->support_used > body->support_capacity) {
        pattern->support_capacity =
            sbi_min_int(most - pattern->support_used, pattern->support_used / 2) + pattern->support_used;
        pattern->support_blocks = sbi_alloc(&body->allocator, (size_t)pattern->support_capacity, 9 * sizeof(sb_real));
    }
    if (body->damping_blocks)
        pattern->damping_blocks = sbi_alloc(&body->allocator, (size_t)most + 1, 9 * sizeof(sb_real));
    if (!pattern->memory || (pattern->support_used > body->support_capacity && !pattern->support_blocks) ||
        (body->damping_blocks && !pattern->damping_blocks))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a tangent of %d blocks", most);
    arena.base = (unsigned char *)pattern->memory;
    arena.used = 0;
    sbi_body_pattern_layout(body, pattern, &arena);
    return SB_OK;
}

SBI_API void sbi_body_free_pattern(const sb_body *body, sbi_body_pattern *pattern)
{
    sbi_free(&body->allocator, pattern->extra_start);
    sbi_free(&body->allocator, pattern->memory);
    sbi_free(&body->allocator, pattern->support_blocks);
    sbi_free(&body->allocator, pattern->damping_blocks);
    sb_preconditioner_free(pattern->precond);
    sbi_elimination_free(pattern->elimination);
    sb_matrix_free(&pattern->matrix);
    memset(pattern, 0, sizeof *pattern);
}

SBI_API sbi_elimination_setup sbi_body_elimination_setup(const sb_body *body, const sb_matrix *matrix)
{
    sbi_elimination_setup setup;
    setup.matrix = matrix;
    setup.positions = body->reference;
    setup.precond = body->precond;
    setup.allocator = &body->allocator;
    return setup;
}

SBI_API sb_result sbi_body_finish_pattern(const sb_body *body, const unsigned char *fixed, sbi_body_pattern *pattern,
                                          sb_error *error)
{
    sb_result result = sbi_body_make_matrix(body, pattern->extra_count, pattern->extra_start, pattern->extra_nodes,
                                            &pattern->matrix, error);
    if (result == SB_OK)
        result = sbi_body_make_block_arrays(body, fixed, pattern, error);
    if (result == SB_OK)
        result = sbi_assembly_reserve_remap(&body->assembly, &pattern->matrix, error);
    if (result == SB_OK)
        result = sbi_precond_remake(body->precond, &pattern->matrix, body->reference, NULL, &body->allocator,
                                    &pattern->precond, error);
    if (result != SB_OK)
        sbi_body_free_pattern(body, pattern);
    return result;
}

SBI_API sb_result sbi_body_make_pattern(const sb_body *body, int cell_count, const int *cell_start, const int *cells,
                                        sbi_body_pattern *pattern, sb_error *error)
{
    sb_result result;
    memset(pattern, 0, sizeof *pattern);
    result = sbi_body_make_extra(body, cell_count, cell_start, cells, pattern, error);
    if (result != SB_OK || !pattern->needed)
        return result;
    result = sbi_body_finish_pattern(body, body->fixed, pattern, error);
    if (result == SB_OK && body->elimination) {
        sbi_elimination_setup setup = sbi_body_elimination_setup(body, &pattern->matrix);
        result = sbi_elimination_remake(body->elimination, &setup, &pattern->elimination, error);
        if (result != SB_OK)
            sbi_body_free_pattern(body, pattern);
    }
    return result;
}

SBI_API void sbi_body_take_pattern(sb_body *body, sbi_body_pattern *pattern)
{
    if (!pattern->needed)
        return;
    sbi_free(&body->allocator, body->extra_start);
    sbi_free(&body->allocator, body->pattern_memory);
    sb_preconditioner_free(body->precond);
    sb_matrix_free(&body->matrix);
    body->extra_count = pattern->extra_count;
    body->extra_start = pattern->extra_start;
    body->extra_nodes = pattern->extra_nodes;
    body->pattern_memory = pattern->memory;
    body->precond = pattern->precond;
    body->matrix = pattern->matrix;
    if (body->elimination) {
        sbi_elimination_free(body->elimination);
        body->elimination = pattern->elimination;
    }
    body->support_used = pattern->support_used;
    body->support_capacity = pattern->support_capacity;
    if (pattern->support_blocks) {
        sbi_free(&body->allocator, body->support_blocks);
        body->support_blocks = (sb_real(*)[9])pattern->support_blocks;
    }
    if (pattern->damping_blocks) {
        sbi_free(&body->allocator, body->damping_blocks);
        body->damping_blocks = (sb_real(*)[9])pattern->damping_blocks;
    }
    sbi_assembly_remap(&body->assembly, &body->matrix, pattern->pair_start);
    if (body->mass_blocks) {
        body->mass_blocks = pattern->mass_blocks;
        sbi_body_update_mass(body);
    }
    body->pattern_version++;
    sbi_kept_forget(body);
    memset(pattern, 0, sizeof *pattern);
}

SBI_API sb_result sbi_body_extend_pattern(sb_body *body, int cell_count, const int *cell_start, const int *cells,
                                          sb_error *error)
{
    sbi_body_pattern pattern;
    sb_result result = sbi_body_make_pattern(body, cell_count, cell_start, cells, &pattern, error);
    if (result == SB_OK && pattern.needed)
        result = sbi_body_reserve_rigids(body, body->rigids,
                                         pattern.elimination ? &pattern.elimination->matrix : &pattern.matrix, error);
    if (result == SB_OK)
        sbi_body_take_pattern(body, &pattern);
    else
        sbi_body_free_pattern(body, &pattern);
    return result;
}

/* ---- the preconditioner ---- */

SBI_API sb_real sbi_body_poisson(const sb_body *body)
{
    sb_real largest = -1;
    for (int k = 0; k < body->material_count; k++) {
        sb_real poisson = sb_material_poisson(body->materials + k);
        largest = poisson > largest ? poisson : largest;
    }
    return largest;
}

SBI_API sb_result sbi_body_update_precond(sb_body *body, sb_preconditioner *precond, sb_matrix *matrix,
                                          const sbi_guests *guests, sb_error *error)
{
    sbi_kept_spoil(body);
    sbi_precond_set_poisson(precond, sbi_body_poisson(body));
    return sbi_pcg_update_preconditioner(precond, matrix, body->position, guests, &body->pcg, error);
}

SBI_API sb_result sbi_body_make_moduli(const sb_body *body, const sb_real *young, const sb_matrix *matrix,
                                       sb_real **moduli, sb_error *error)
{
    const sb_domain *domain = &body->domain;
    sb_real *of_cell;
    sb_result result;
    *moduli = NULL;
    if (body->material_count < 2)
        return SB_OK;
    of_cell = (sb_real *)sbi_alloc(&body->allocator, (size_t)domain->cell_count, sizeof(sb_real));
    *moduli = (sb_real *)sbi_alloc(&body->allocator, (size_t)matrix->block_count, sizeof(sb_real));
    if (of_cell && *moduli) {
        for (int e = 0; e < domain->cell_count; e++) {
            int k = body->cell_material[e];
            of_cell[e] = !sbi_live_has_cell(body, e) ? 0 : young ? young[k] : sb_material_young(body->materials + k);
        }
        result = sb_preconditioner_moduli(matrix, domain->cell_count, domain->nodes_per_cell, domain->cells, of_cell,
                                          *moduli, error);
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the moduli of %d blocks", matrix->block_count);
    }
    sbi_free(&body->allocator, of_cell);
    if (result != SB_OK) {
        sbi_free(&body->allocator, *moduli);
        *moduli = NULL;
    }
    return result;
}

SBI_API sb_result sbi_body_make_preconditioner(sb_body *body, const sb_body_def *def, sb_error *error)
{
    sb_preconditioner_def settings = sb_default_preconditioner_def();
    sb_real *moduli = NULL;
    sb_result result = SB_OK;
    settings.kind = def->preconditioner;
    settings.positions = def->mesh->nodes;
    settings.jobs = body->jobs;
    settings.levels = def->levels;
    settings.level_count = def->level_count;
    if (settings.kind == SB_PRECOND_AUTO)
        settings.kind = sb_solver_auto(&body->matrix);
    if (settings.kind == SB_PRECOND_MULTIGRID)
        result = sbi_body_make_moduli(body, body->made_young, &body->matrix, &moduli, error);
    settings.moduli = moduli;
    if (result == SB_OK)
        result = sb_preconditioner_create(&settings, &body->matrix, &body->allocator, &body->precond, error);
    sbi_free(&body->allocator, moduli);
    return result;
}

SBI_API sb_result sbi_body_remake_preconditioner(sb_body *body, const sb_preconditioner *like, sb_error *error)
{
    sb_real *moduli = NULL;
    sb_result result = SB_OK;
    if (sb_preconditioner_get_info(like).kind == SB_PRECOND_MULTIGRID)
        result = sbi_body_make_moduli(body, body->made_young, &body->matrix, &moduli, error);
    if (result == SB_OK)
        result =
            sbi_precond_remake(like, &body->matrix, body->reference, moduli, &body->allocator, &body->precond, error);
    sbi_free(&body->allocator, moduli);
    return result;
}

SBI_API sb_result sbi_body_rehearse_preconditioner(sb_body *body, sb_error *error)
{
    sb_preconditioner *kept = body->precond;
    sb_result result = SB_OK;
    if (!kept || sb_preconditioner_get_info(kept).kind != SB_PRECOND_MULTIGRID)
        return SB_OK;
    result = sbi_body_remake_preconditioner(body, kept, error);
    if (result == SB_OK)
        sb_preconditioner_free(body->precond);
    body->precond = kept;
    return result;
}

SBI_API sb_result sbi_body_settle_preconditioner(sb_body *body, sb_error *error)
{
    sb_preconditioner *before = body->precond;
    sb_result result;
    if (sbi_precond_settle(before, &body->matrix))
        return SB_OK;
    result = sbi_body_remake_preconditioner(body, before, error);
    if (result != SB_OK)
        return result;
    sbi_precond_set_memory(body->precond, sbi_precond_get_memory(before));
    sb_preconditioner_free(before);
    return SB_OK;
}
