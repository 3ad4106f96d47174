/* assembly_patch: the change of volume of patches of tet4, as part of what the cells hold. */
#include "assembly_patch.h"
#include "assembly_batch.h"
#include "material_law.h"
#include "material_models.h"

#include <string.h>

/* ---- lists: count items at start[k], begin, fill at start[k]++, end ---- */

static void sbi_patches_begin(int *start, int count)
{
    int sum = 0;
    for (int k = 0; k <= count; k++) {
        int items = start[k];
        start[k] = sum;
        sum += items;
    }
}

static void sbi_patches_end(int *start, int count)
{
    memmove(start + 1, start, (size_t)count * sizeof *start);
    start[0] = 0;
}

static void sbi_patches_list_cells(const sb_domain *domain, sbi_patches *p)
{
    memset(p->cell_start, 0, ((size_t)p->count + 1) * sizeof(int));
    for (int e = 0; e < domain->cell_count; e++)
        if (domain->cell_patch[e] >= 0)
            p->cell_start[domain->cell_patch[e]]++;
    sbi_patches_begin(p->cell_start, p->count);
    for (int e = 0; e < domain->cell_count; e++)
        if (domain->cell_patch[e] >= 0)
            p->cells[p->cell_start[domain->cell_patch[e]]++] = e;
    sbi_patches_end(p->cell_start, p->count);
}

/* The nodes of patch k, each once: returns how many; stored ascending in nodes, unless NULL. seen: [node_count]. */
static int sbi_patches_list_nodes(const sb_domain *domain, const sbi_patches *p, int k, int *seen, int *nodes)
{
    int count = 0;
    for (int c = p->cell_start[k]; c < p->cell_start[k + 1]; c++)
        for (int a = 0; a < 4; a++) {
            int node = domain->cells[4 * (size_t)p->cells[c] + (size_t)a], at = count;
            if (seen[node] == k)
                continue;
            seen[node] = k;
            count++;
            for (; nodes && at > 0 && nodes[at - 1] > node; at--)
                nodes[at] = nodes[at - 1];
            if (nodes)
                nodes[at] = node;
        }
    return count;
}

/* Places of the cells' nodes in their patch, and the entries of nodes. */
static void sbi_patches_list_entries(const sb_domain *domain, sbi_patches *p)
{
    int *start = p->entry_start;
    for (int k = 0; k < p->count; k++) {
        const int *nodes = p->nodes + p->node_start[k];
        for (int c = 4 * p->cell_start[k]; c < 4 * p->cell_start[k + 1]; c++) {
            int node = domain->cells[4 * (size_t)p->cells[c / 4] + (size_t)(c % 4)], at = 0;
            while (nodes[at] != node)
                at++;
            p->corners[c] = at;
        }
    }
    memset(start, 0, ((size_t)domain->node_count + 1) * sizeof *start);
    for (int i = 0; i < p->node_start[p->count]; i++)
        start[p->nodes[i]]++;
    sbi_patches_begin(start, domain->node_count);
    for (int k = 0; k < p->count; k++)
        for (int i = p->node_start[k]; i < p->node_start[k + 1]; i++) {
            int at = start[p->nodes[i]]++;
            p->entries[at] = i;
            p->owners[at] = k;
        }
    sbi_patches_end(start, domain->node_count);
}

static void sbi_patches_layout(sbi_patches *p, const sb_domain *domain, sbi_arena *arena)
{
    size_t count = (size_t)p->count, entries = (size_t)p->node_start[p->count], pairs = 0;
    for (int k = 0; k < p->count; k++) {
        size_t n = (size_t)(p->node_start[k + 1] - p->node_start[k]);
        pairs += n * n;
    }
    p->corners = (int *)sbi_arena_take(arena, (size_t)domain->cell_count, 4 * sizeof(int));
    p->nodes = (int *)sbi_arena_take(arena, entries, sizeof(int));
    p->entry_start = (int *)sbi_arena_take(arena, (size_t)domain->node_count + 1, sizeof(int));
    p->entries = (int *)sbi_arena_take(arena, entries, sizeof(int));
    p->owners = (int *)sbi_arena_take(arena, entries, sizeof(int));
    p->pair_start = (size_t *)sbi_arena_take(arena, count + 1, sizeof(size_t));
    p->pairs = (int *)sbi_arena_take(arena, pairs, sizeof(int));
    p->slopes = (sb_vec3 *)sbi_arena_take(arena, entries, sizeof(sb_vec3));
    p->pressure = (sb_real *)sbi_arena_take(arena, count, sizeof(sb_real));
    p->stiffness = (sb_real *)sbi_arena_take(arena, count, sizeof(sb_real));
    p->energy = (sb_real *)sbi_arena_take(arena, count, sizeof(sb_real));
    p->pull = (sb_real *)sbi_arena_take(arena, count, sizeof(sb_real));
    p->admissible = (unsigned char *)sbi_arena_take(arena, count, 1);
}

static void sbi_patches_lists_layout(sbi_patches *p, const sb_domain *domain, sbi_arena *arena)
{
    p->cell_start = (int *)sbi_arena_take(arena, (size_t)p->count + 1, sizeof(int));
    p->node_start = (int *)sbi_arena_take(arena, (size_t)p->count + 1, sizeof(int));
    p->cells = (int *)sbi_arena_take(arena, (size_t)domain->cell_count, sizeof(int));
}

/* Measures, allocates, and hands out again. */
static void *sbi_patches_take(sbi_patches *p, const sb_domain *domain, const sb_allocator *allocator,
                              void (*layout)(sbi_patches *, const sb_domain *, sbi_arena *))
{
    sbi_arena arena = {NULL, 0, 0};
    layout(p, domain, &arena);
    arena.base = (unsigned char *)(arena.overflow ? NULL : sbi_alloc_zeroed(allocator, arena.used, 1));
    arena.used = 0;
    if (arena.base)
        layout(p, domain, &arena);
    return arena.base;
}

/* Cells and counts of nodes, then all the rest. seen: [node_count] scratch. */
static int sbi_patches_fill(sbi_patches *p, const sb_domain *domain, int *seen, const sb_allocator *allocator)
{
    size_t bytes = (size_t)domain->node_count * sizeof *seen;
    p->lists = sbi_patches_take(p, domain, allocator, sbi_patches_lists_layout);
    if (!p->lists)
        return 0;
    sbi_patches_list_cells(domain, p);
    memset(seen, -1, bytes);
    for (int k = 0; k < p->count; k++)
        p->node_start[k + 1] = p->node_start[k] + sbi_patches_list_nodes(domain, p, k, seen, NULL);
    p->memory = sbi_patches_take(p, domain, allocator, sbi_patches_layout);
    if (!p->memory)
        return 0;
    memset(seen, -1, bytes);
    for (int k = 0; k < p->count; k++) {
        size_t n = (size_t)sbi_patches_list_nodes(domain, p, k, seen, p->nodes + p->node_start[k]);
        p->pair_start[k + 1] = p->pair_start[k] + n * n;
    }
    sbi_patches_list_entries(domain, p);
    return 1;
}

SBI_API void sbi_patches_free(sbi_patches *patches, const sb_allocator *allocator)
{
    if (!patches)
        return;
    sbi_free(allocator, patches->lists);
    sbi_free(allocator, patches->memory);
    sbi_free(allocator, patches);
}

SBI_API sb_result sbi_patches_create(const sb_domain *domain, const sb_allocator *allocator, sbi_patches **patches,
                                     sb_error *error)
{
    sbi_patches *made;
    int *seen, filled;
    *patches = NULL;
    if (!domain->cell_patch)
        return SB_OK;
    made = (sbi_patches *)sbi_alloc_zeroed(allocator, 1, sizeof *made);
    seen = (int *)sbi_alloc(allocator, (size_t)domain->node_count, sizeof(int));
    if (made)
        made->count = domain->patch_count;
    filled = made && seen && sbi_patches_fill(made, domain, seen, allocator);
    sbi_free(allocator, seen);
    if (!filled) {
        sbi_patches_free(made, allocator);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d patches of elements", domain->patch_count);
    }
    *patches = made;
    return SB_OK;
}

SBI_API void sbi_patches_map(sbi_patches *patches, const sb_matrix *matrix)
{
    int *pair = patches->pairs;
    for (int k = 0; k < patches->count; k++)
        for (int a = patches->node_start[k]; a < patches->node_start[k + 1]; a++)
            for (int b = patches->node_start[k]; b < patches->node_start[k + 1]; b++)
                *pair++ = sb_matrix_find(matrix, patches->nodes[a], patches->nodes[b]);
}

/* ---- one cell ---- */

static const sb_material *sbi_patch_shares(const sbi_assembly *assembly, int e)
{
    return assembly->shares + 2 * (size_t)assembly->cell_material[e];
}

/* The change of volume of what the model takes for it, from F = I + h, and its derivative by F. Where volumes count, J
 * is that of F alone. */
static sb_real sbi_patch_change(const sb_material *m, const sb_mat3 *h, const sb_mat3 *f, sb_quat *rotation,
                                sb_mat3 *slope)
{
    switch (m->model) {
    case SB_LINEAR: *slope = sb_m3_identity(); return sb_m3_trace(*h);
    case SB_COROTATED:
    case SB_COROTATED_INVERTIBLE:
        *slope = sbi_corotate((int)m->model, f, rotation).r;
        return sb_m3_ddot(*slope, *h) + (sb_m3_trace(*slope) - 3);
    case SB_SVK: {
        sb_mat3 g = m->prestretch, whole;
        if (!sbi_material_is_prestretched(m)) {
            *slope = *f;
            return sb_m3_trace(*h) + sb_m3_ddot(*h, *h) / 2;
        }
        whole = sb_m3_mul(*f, g);
        *slope = sb_m3_mult(whole, g);
        return (sb_m3_ddot(whole, whole) - 3) / 2;
    }
    default: {
        sb_mat3 cofactor = sb_m3_cofactor(*h);
        *slope = sb_m3_cofactor(*f);
        return sb_m3_trace(*h) + sb_m3_trace(cofactor) + sb_v3_dot(sb_m3_column(*h, 0), sb_m3_column(cofactor, 0));
    }
    }
}

/* By how much the determinant of a material's own F is that of the mesh's. */
static sb_real sbi_patch_growth(const sb_material *m)
{
    return sbi_material_is_prestretched(m) ? sb_m3_det(m->prestretch) : (sb_real)1;
}

/* 1: the change of volume is J - 1. */
static int sbi_patch_is_by_volume(const sb_material *m) { return (int)m->model > SB_SVK; }

/* Models whose shear has a share of U, that of F = J^(1/3) I: mu/2 (I1 - 3) is mu/2 (I1 - 3 J^(2/3)), which is least
 * for these F, and the rest. */
static int sbi_patch_scales(const sb_material *m)
{
    return m->model == SB_NEO_HOOKEAN || m->model == SB_STABLE_NEO_HOOKEAN;
}

/* That share at J and its derivatives. Below a fifth of the volume it goes on as a parabola: what the point has besides
 * it then keeps its barrier, and its resistance to turning inside out. */
static void sbi_patch_scaling(const sb_material *m, sb_real J, sb_real u[3])
{
    const sb_real least = (sb_real)0.2, mu = m->mu;
    sb_real x = sb_max(J, least), root = sb_cbrt(x), d = J - x;
    u[0] = (sb_real)1.5 * mu * (root * root - 1), u[1] = mu / root, u[2] = -mu / (3 * root * x);
    if (m->model == SB_NEO_HOOKEAN)
        u[0] -= mu * sb_log(x), u[1] -= mu / x, u[2] += mu / (x * x);
    else
        u[0] += mu * (x - 1) * ((x - 1) / 2 - 1), u[1] += mu * (x - 2), u[2] += mu;
    u[0] += d * (u[1] + d * u[2] / 2);
    u[1] += d * u[2];
}

/* U, U' and U'' of a change s of the mesh's volume; 0: not admissible. */
static int sbi_patch_response(const sb_material *m, sb_real s, sb_real u[3])
{
    int isochoric = (int)m->model >= SB_MOONEY_RIVLIN || m->model == SB_NEO_HOOKEAN_ISOCHORIC;
    int by_volume = sbi_patch_is_by_volume(m);
    sb_real growth = sbi_patch_growth(m), k = isochoric ? 2 / m->d1 : m->lambda;
    if (by_volume)
        s = s * growth + (growth - 1);
    else
        k += 2 * m->mu / 3;
    if ((isochoric || m->model == SB_NEO_HOOKEAN) && !(1 + s > 0))
        return 0;
    u[0] = k / 2 * s * s, u[1] = k * s, u[2] = k;
    if (m->model == SB_NEO_HOOKEAN) {
        sb_real J = 1 + s, l = sb_log(J);
        u[0] = k / 2 * l * l, u[1] = k * l / J, u[2] = k * (1 - l) / (J * J);
    }
    if (sbi_patch_scales(m)) {
        sb_real own[3];
        sbi_patch_scaling(m, 1 + s, own);
        for (int i = 0; i < 3; i++)
            u[i] += own[i];
    }
    u[0] /= growth;
    u[1] *= by_volume ? (sb_real)1 : 1 / growth;
    u[2] *= by_volume ? growth : 1 / growth;
    return sb_is_finite(u[0]) && sb_is_finite(u[1]) && sb_is_finite(u[2]);
}

/* ---- a point's share ---- */

SBI_API sb_material sbi_patch_shear(const sb_material *material)
{
    sb_material m = sbi_material_share_of(material, SBI_SHARE_SHEAR);
    if (!sbi_patch_is_by_volume(&m))
        m.lambda = -2 * m.mu / 3;
    return m;
}

SBI_API sb_material sbi_assembly_share(const sb_domain *domain, const sb_material *material, int of_volume)
{
    if (domain->cell_patch)
        return of_volume ? *material : sbi_patch_shear(material);
    return sbi_material_share_of(material, !domain->mean_points ? SBI_SHARE_WHOLE
                                           : of_volume          ? SBI_SHARE_VOLUME
                                                                : SBI_SHARE_SHEAR);
}

SBI_API sb_real sbi_patch_kept_lambda(const sb_material *whole, const sb_material *relaxed)
{
    return sbi_patch_is_by_volume(whole) ? 2 * (whole->mu - relaxed->mu) / 3 : 0;
}

SBI_API void sbi_patch_take_energy(const sb_material *whole, const sb_mat3 *f, sb_real *energy)
{
    sb_real u[3], growth = sbi_patch_growth(whole);
    if (!sbi_patch_scales(whole))
        return;
    sbi_patch_scaling(whole, sb_m3_det(*f) * growth, u);
    *energy -= u[0] / growth;
}

SBI_API void sbi_patch_take_stress(const sb_material *whole, const sb_mat3 *f, sb_mat3 *stress)
{
    sb_real u[3];
    if (!sbi_patch_scales(whole))
        return;
    sbi_patch_scaling(whole, sb_m3_det(*f) * sbi_patch_growth(whole), u);
    *stress = sb_m3_sub(*stress, sb_m3_scale(u[1], sb_m3_cofactor(*f)));
}

/* Where a force left the rotation of a cell. */
static sb_quat sbi_patch_quat(const sbi_assembly *assembly, int e)
{
    return assembly->batched && assembly->batch_quats ? sbi_batch_get_quat(assembly, e) : assembly->rotations[e];
}

/* sum_a (u_a - u_0) g_a^T */
static sb_mat3 sbi_patch_gradient(const sb_domain *domain, int e, const sb_vec3 *u)
{
    const int *cell = domain->cells + 4 * (size_t)e;
    const sb_real *g = domain->gradients + 12 * (size_t)e;
    sb_mat3 h = sb_m3_zero();
    for (int a = 1; a < 4; a++) {
        sb_vec3 d = sb_v3_sub(u[cell[a]], u[cell[0]]);
        h = sb_m3_add(h, sb_m3_outer(d, sb_v3(g[3 * a], g[3 * a + 1], g[3 * a + 2])));
    }
    return h;
}

/* s and ds/dF of a cell at u. */
static sb_real sbi_patch_cell(const sbi_assembly *assembly, int e, const sb_vec3 *u, int turned, sb_mat3 *slope)
{
    const sb_material *m = sbi_patch_shares(assembly, e) + 1;
    sb_quat rotation = sb_quat_identity();
    sb_mat3 h, f;
    if (m->model == SB_COROTATED)
        rotation = sbi_patch_quat(assembly, e);
    h = sbi_patch_gradient(assembly->domain, e, u);
    if (m->model == SB_COROTATED && turned) {
        *slope = sb_quat_to_mat3(rotation);
        return sb_m3_ddot(*slope, h) + (sb_m3_trace(*slope) - 3);
    }
    f = sb_m3_add(sb_m3_identity(), h);
    return sbi_patch_change(m, &h, &f, &rotation, slope);
}

/* ---- one patch ---- */

typedef struct sbi_patch_state {
    sb_real volume;   /* m^3 */
    sb_real stiff;    /* mean of the cells' stiffness factors */
    sb_real change;   /* s */
    sb_real value[3]; /* U (J/m^3), U', U'' (Pa), times that mean */
} sbi_patch_state;

/* Adds w ds/dF g_a of a cell to its nodes'. */
static void sbi_patch_spread(const sb_domain *domain, int e, const sb_mat3 *slope, const int *corners, sb_vec3 *slopes)
{
    const sb_real *g = domain->gradients + 12 * (size_t)e;
    sb_mat3 weighted = sb_m3_scale(domain->weights[e], *slope);
    for (int a = 0; a < 4; a++) {
        sb_vec3 *to = slopes + corners[a];
        *to = sb_v3_add(*to, sb_m3_apply(weighted, sb_v3(g[3 * a], g[3 * a + 1], g[3 * a + 2])));
    }
}

/* The values of a patch whose change of volume, volume and stiffness are there. */
static int sbi_patch_respond(const sbi_assembly *assembly, int k, sbi_patch_state *state)
{
    const sbi_patches *p = assembly->patches;
    const sb_material *whole = sbi_patch_shares(assembly, p->cells[p->cell_start[k]]) + 1;
    int admissible = sbi_patch_response(whole, state->change, state->value);
    for (int i = 0; i < 3; i++)
        state->value[i] = admissible ? state->stiff * state->value[i] : 0;
    return admissible;
}

/* sbi_patch_evaluate of batched cells at their rotations, in fewer sums: with x_a = w R g_a of nodes a >= 1,
 * w (tr(R^T F) - 3) = sum_a x_a . (u_a - u_0) + w (tr R - 3), and the first sums over cells are those over nodes. */
static int sbi_patch_evaluate_batched(const sbi_assembly *assembly, int k, const sb_vec3 *u, sb_vec3 *slopes,
                                      sbi_patch_state *state)
{
    const sbi_patches *p = assembly->patches;
    const sb_domain *domain = assembly->domain;
    const int *nodes = p->nodes + p->node_start[k];
    int count = p->node_start[k + 1] - p->node_start[k];
    sb_real sum = 0, stiff = 0;
    memset(state, 0, sizeof *state);
    for (int i = 0; i < count; i++)
        slopes[i] = sb_v3(0, 0, 0);
    for (int c = p->cell_start[k]; c < p->cell_start[k + 1]; c++) {
        int e = p->cells[c];
        const int *corners = p->corners + 4 * (size_t)c;
        const sb_real *g = domain->gradients + 12 * (size_t)e;
        sb_real w = domain->weights[e];
        sb_quat q = sbi_batch_get_quat(assembly, e);
        sb_mat3 r = sb_m3_scale(w, sb_quat_to_mat3(q));
        sb_vec3 first = slopes[corners[0]];
        for (int a = 1; a < 4; a++) {
            sb_vec3 x = sb_m3_apply(r, sb_v3(g[3 * a], g[3 * a + 1], g[3 * a + 2]));
            slopes[corners[a]] = sb_v3_add(slopes[corners[a]], x);
            first = sb_v3_sub(first, x);
        }
        slopes[corners[0]] = first;
        sum -= 4 * w * (q.x * q.x + q.y * q.y + q.z * q.z); /* tr R - 3 */
        state->volume += w;
        stiff += w * sbi_assembly_stiffness(assembly, e);
    }
    if (!(state->volume > 0))
        return 1;
    for (int i = 1; u && i < count; i++)
        sum += sb_v3_dot(slopes[i], sb_v3_sub(u[nodes[i]], u[nodes[0]]));
    state->change = u ? sum / state->volume : 0;
    state->stiff = stiff / state->volume;
    return sbi_patch_respond(assembly, k, state);
}

/* The state of patch k, and the slopes of its nodes unless NULL; 0: not admissible, the values are 0. */
static int sbi_patch_evaluate(const sbi_assembly *assembly, int k, const sb_vec3 *u, int turned, sb_vec3 *slopes,
                              sbi_patch_state *state)
{
    const sbi_patches *p = assembly->patches;
    const sb_domain *domain = assembly->domain;
    sb_real sum = 0, stiff = 0;
    if (assembly->batched && turned && slopes)
        return sbi_patch_evaluate_batched(assembly, k, u, slopes, state);
    memset(state, 0, sizeof *state);
    for (int i = 0; slopes && i < p->node_start[k + 1] - p->node_start[k]; i++)
        slopes[i] = sb_v3(0, 0, 0);
    for (int c = p->cell_start[k]; c < p->cell_start[k + 1]; c++) {
        int e = p->cells[c];
        sb_mat3 slope;
        sb_real w = domain->weights[e], change = sbi_patch_cell(assembly, e, u, turned, &slope);
        state->volume += w;
        stiff += w * sbi_assembly_stiffness(assembly, e);
        sum += w * change;
        if (slopes)
            sbi_patch_spread(domain, e, &slope, p->corners + 4 * (size_t)c, slopes);
    }
    if (!(state->volume > 0))
        return 1;
    state->change = sum / state->volume;
    state->stiff = stiff / state->volume;
    return sbi_patch_respond(assembly, k, state);
}

/* ---- all patches ---- */

/* Patches and nodes of a task: what they are depends on the mesh alone. */
enum { SBI_PATCH_TASK = 32, SBI_PATCH_NODES = 256 };

typedef struct sbi_patch_job {
    sbi_assembly *assembly;
    const sb_vec3 *u, *x;
    int turned, wants_slopes;
    sb_vec3 *force;
    sb_tangent_kind kind;
    const sb_real *factors;
    sb_real factor;
    sb_matrix *matrix;
} sbi_patch_job;

static int sbi_patch_tasks(int count, int size) { return count > 0 ? (count - 1) / size + 1 : 0; }

static void sbi_patches_update_task(void *user, int task)
{
    const sbi_patch_job *job = (const sbi_patch_job *)user;
    const sbi_patches *p = job->assembly->patches;
    int end = sbi_min_int(p->count, (task + 1) * SBI_PATCH_TASK);
    for (int k = task * SBI_PATCH_TASK; k < end; k++) {
        sbi_patch_state state;
        sb_vec3 *slopes = job->wants_slopes ? p->slopes + p->node_start[k] : NULL;
        p->admissible[k] = (unsigned char)sbi_patch_evaluate(job->assembly, k, job->u, job->turned, slopes, &state);
        p->energy[k] = state.volume * state.value[0];
        p->pressure[k] = state.value[1];
        p->stiffness[k] = state.volume > 0 ? state.value[2] / state.volume : 0;
    }
}

static int sbi_patches_run(sbi_assembly *assembly, const sb_vec3 *u, int turned, int wants_slopes)
{
    const sbi_patches *p = assembly->patches;
    sbi_patch_job job;
    memset(&job, 0, sizeof job);
    job.assembly = assembly;
    job.u = u;
    job.turned = turned;
    job.wants_slopes = wants_slopes;
    sbi_run(assembly->jobs, sbi_patches_update_task, &job, sbi_patch_tasks(p->count, SBI_PATCH_TASK));
    for (int k = 0; k < p->count; k++)
        if (!p->admissible[k])
            return p->cells[p->cell_start[k]];
    return -1;
}

SBI_API int sbi_patches_update(sbi_assembly *assembly, const sb_vec3 *u, int turned)
{
    return sbi_patches_run(assembly, u, turned, 1);
}

/* b . x of a patch. */
static sb_real sbi_patch_along(const sbi_patches *p, int k, const sb_vec3 *x)
{
    sb_real sum = 0;
    for (int i = p->node_start[k]; i < p->node_start[k + 1]; i++)
        sum += sb_v3_dot(p->slopes[i], x[p->nodes[i]]);
    return sum;
}

static void sbi_patches_gather_task(void *user, int task)
{
    const sbi_patch_job *job = (const sbi_patch_job *)user;
    const sbi_patches *p = job->assembly->patches;
    int end = sbi_min_int(job->assembly->domain->node_count, (task + 1) * SBI_PATCH_NODES);
    for (int i = task * SBI_PATCH_NODES; i < end; i++)
        for (int at = p->entry_start[i]; at < p->entry_start[i + 1]; at++)
            job->force[i] = sb_v3_madd(job->force[i], p->pull[p->owners[at]], p->slopes[p->entries[at]]);
}

/* force += pull b */
static void sbi_patches_gather(sbi_assembly *assembly, sb_vec3 *force)
{
    sbi_patch_job job;
    memset(&job, 0, sizeof job);
    job.assembly = assembly;
    job.force = force;
    sbi_run(assembly->jobs, sbi_patches_gather_task, &job,
            sbi_patch_tasks(assembly->domain->node_count, SBI_PATCH_NODES));
}

SBI_API int sbi_patches_add_force(sbi_assembly *assembly, const sb_vec3 *u, const sb_vec3 *x, sb_vec3 *force)
{
    const sbi_patches *p = assembly->patches;
    int bad = sbi_patches_update(assembly, u, 1);
    for (int k = 0; k < p->count; k++)
        p->pull[k] = p->pressure[k] + (x ? p->stiffness[k] * sbi_patch_along(p, k, x) : 0);
    sbi_patches_gather(assembly, force);
    return bad;
}

SBI_API int sbi_patches_add_share(sbi_assembly *assembly, const sb_vec3 *u, int material, sb_vec3 *force)
{
    const sbi_patches *p = assembly->patches;
    int bad = sbi_patches_update(assembly, u, 0);
    for (int k = 0; k < p->count; k++)
        p->pull[k] = assembly->cell_material[p->cells[p->cell_start[k]]] == material ? p->pressure[k] : 0;
    sbi_patches_gather(assembly, force);
    return bad;
}

SBI_API void sbi_patches_add_product(sbi_assembly *assembly, const sb_vec3 *x, sb_vec3 *y)
{
    const sbi_patches *p = assembly->patches;
    (void)sbi_patches_update(assembly, NULL, 1);
    for (int k = 0; k < p->count; k++)
        p->pull[k] = p->stiffness[k] * sbi_patch_along(p, k, x);
    sbi_patches_gather(assembly, y);
}

SBI_API sb_real sbi_patches_work(sbi_assembly *assembly, const sb_vec3 *x)
{
    const sbi_patches *p = assembly->patches;
    sb_real sum = 0;
    (void)sbi_patches_update(assembly, NULL, 1);
    for (int k = 0; k < p->count; k++) {
        sb_real along = sbi_patch_along(p, k, x);
        sum += p->stiffness[k] * (along * along);
    }
    return sum;
}

SBI_API int sbi_patches_energy(sbi_assembly *assembly, const sb_vec3 *u, sb_real *energy)
{
    const sbi_patches *p = assembly->patches;
    int bad = sbi_patches_run(assembly, u, 0, 0);
    *energy = 0;
    for (int k = 0; k < p->count; k++)
        *energy += p->energy[k];
    return bad;
}

/* ---- tangent ---- */

/* Adds the patches' parts of a row; upper 1: of what is above the diagonal only. */
static void sbi_patches_add_row(const sbi_patch_job *job, int row, int upper)
{
    const sbi_patches *p = job->assembly->patches;
    for (int at = p->entry_start[row]; at < p->entry_start[row + 1]; at++) {
        int k = p->owners[at], first = p->node_start[k], n = p->node_start[k + 1] - first;
        const int *pairs = p->pairs + p->pair_start[k] + (size_t)(p->entries[at] - first) * (size_t)n;
        sb_real stiffness = job->kind == SB_TANGENT_EXACT ? p->stiffness[k] : sb_max(p->stiffness[k], 0);
        sb_real factor =
            job->factors ? job->factors[job->assembly->cell_material[p->cells[p->cell_start[k]]]] : job->factor;
        sb_vec3 own = sb_v3_scale(factor * stiffness, p->slopes[p->entries[at]]);
        for (int b = upper ? p->entries[at] - first + 1 : 0; b < n; b++) { /* nodes ascend */
            sb_real *block = job->matrix->blocks[pairs[b]];
            sb_vec3 other = p->slopes[first + b];
            block[0] += own.x * other.x, block[1] += own.x * other.y, block[2] += own.x * other.z;
            block[3] += own.y * other.x, block[4] += own.y * other.y, block[5] += own.y * other.z;
            block[6] += own.z * other.x, block[7] += own.z * other.y, block[8] += own.z * other.z;
        }
    }
}

static void sbi_patches_tangent_task(void *user, int task)
{
    const sbi_patch_job *job = (const sbi_patch_job *)user;
    int end = sbi_min_int(job->assembly->domain->node_count, (task + 1) * SBI_PATCH_NODES);
    for (int i = task * SBI_PATCH_NODES; i < end; i++)
        sbi_patches_add_row(job, i, 0);
}

SBI_API void sbi_patches_add_upper(sbi_assembly *assembly, const sb_real *factors, sb_real factor, int row,
                                   sb_matrix *matrix)
{
    sbi_patch_job job;
    memset(&job, 0, sizeof job);
    job.assembly = assembly;
    job.kind = SB_TANGENT_QUASI;
    job.factors = factors;
    job.factor = factor;
    job.matrix = matrix;
    sbi_patches_add_row(&job, row, 1);
}

SBI_API void sbi_patches_add_tangent(sbi_assembly *assembly, sb_tangent_kind kind, const sb_real *factors,
                                     sb_real factor, sb_matrix *matrix)
{
    sbi_patch_job job;
    memset(&job, 0, sizeof job);
    job.assembly = assembly;
    job.kind = kind;
    job.factors = factors;
    job.factor = factor;
    job.matrix = matrix;
    sbi_run(assembly->jobs, sbi_patches_tangent_task, &job,
            sbi_patch_tasks(assembly->domain->node_count, SBI_PATCH_NODES));
}

/* A += p d2J/dF2, which is that of the cofactor: no division, and fine at J <= 0. */
static void sbi_patch_add_cofactor_change(const sb_mat3 *f, sb_real p, sb_real *tangent)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 2; k++)
                for (int l = 0; l < 2; l++) { /* e_ikm e_jln F_mn, m and n being what is left */
                    int row = (i + 1 + k) % 3, column = (j + 1 + l) % 3, m = (i + 2 - k) % 3, n = (j + 2 - l) % 3;
                    tangent[9 * (3 * i + j) + 3 * row + column] += (k == l ? p : -p) * f->m[m][n];
                }
}

/* A += p I (x) I of the indices i, k and the metric's j, l. */
static void sbi_patch_add_metric(sb_mat3 metric, sb_real p, sb_real *tangent)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            for (int l = 0; l < 3; l++)
                tangent[9 * (3 * i + j) + 3 * i + l] += p * metric.m[j][l];
}

/* Of a corotated point without lambda A = 2 mu (I - dR/dF): with it and the pressure p of its patch,
 * A + lambda R (x) R + (lambda t + p) dR/dF, t = tr(R^T F) - 3. */
static void sbi_patch_finish_corotated(const sb_material *shear, const sb_mat3 *f, sb_quat rotation, sb_real p,
                                       sb_real *tangent)
{
    sb_mat3 h = sb_m3_sub(*f, sb_m3_identity()), r;
    sb_real turn = shear->lambda * sbi_patch_change(shear, &h, f, &rotation, &r) + p;
    for (int i = 0; i < 81; i++)
        tangent[i] = (1 - turn / (2 * shear->mu)) * tangent[i] + (i % 10 == 0 ? turn : 0);
    sbi_tangent_add_dyad(tangent, shear->lambda, r);
}

/* The tangent of the patch's pressure on a cell by volume, and what the point has less than its model. */
static void sbi_patch_finish_by_volume(const sb_material *whole, const sb_mat3 *f, sb_real p, sb_real *tangent)
{
    if (sbi_patch_scales(whole)) {
        sb_real u[3], growth = sbi_patch_growth(whole);
        sbi_patch_scaling(whole, sb_m3_det(*f) * growth, u);
        sbi_tangent_add_dyad(tangent, -u[2] * growth, sb_m3_cofactor(*f));
        p -= u[1];
    }
    sbi_patch_add_cofactor_change(f, p, tangent);
}

SBI_API sb_material sbi_patch_tangent_share(const sb_material *shear)
{
    sb_material m = *shear;
    if (m.model == SB_COROTATED || m.model == SB_COROTATED_INVERTIBLE)
        m.lambda = 0;
    return m;
}

SBI_API int sbi_patches_finish_tangent(const sbi_assembly *assembly, int cell, const sb_mat3 *f, sb_quat rotation,
                                       sb_tangent_kind kind, sb_real *tangent)
{
    const sb_material *shares = sbi_patch_shares(assembly, cell);
    int k = assembly->domain->cell_patch[cell];
    sb_real p = assembly->patches->pressure[k] / sbi_assembly_stiffness(assembly, cell);
    if (!assembly->patches->admissible[k])
        return 0;
    switch (shares->model) {
    case SB_LINEAR: break;
    case SB_COROTATED:
    case SB_COROTATED_INVERTIBLE: sbi_patch_finish_corotated(shares, f, rotation, p, tangent); break;
    case SB_SVK:
        sbi_patch_add_metric(sbi_material_is_prestretched(shares) ? sb_m3_mult(shares->prestretch, shares->prestretch)
                                                                  : sb_m3_identity(),
                             p, tangent);
        break;
    default: sbi_patch_finish_by_volume(shares + 1, f, p, tangent); break;
    }
    return kind == SB_TANGENT_EXACT || sbi_law_project(tangent);
}

/* ---- readings ---- */

SBI_API int sbi_patches_cell_stress(const sbi_assembly *assembly, int cell, const sb_vec3 *u, sb_mat3 *stress)
{
    sbi_patch_state state;
    sb_mat3 slope;
    int k = assembly->domain->cell_patch[cell];
    if (k < 0)
        return 1;
    (void)sbi_patch_cell(assembly, cell, u, 0, &slope);
    if (!sbi_patch_evaluate(assembly, k, u, 0, NULL, &state))
        return 0;
    *stress = sb_m3_add(*stress, sb_m3_scale(state.value[1], slope));
    return 1;
}

SBI_API int sbi_patches_cell_energy(const sbi_assembly *assembly, int cell, const sb_vec3 *u, sb_real *energy)
{
    sbi_patch_state state;
    int k = assembly->domain->cell_patch[cell];
    if (k < 0)
        return 1;
    if (!sbi_patch_evaluate(assembly, k, u, 0, NULL, &state))
        return 0;
    *energy += assembly->domain->weights[cell] * state.value[0];
    return 1;
}
