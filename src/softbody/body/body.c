/* body: creation, properties, supports, loads, readings. */
#include "body.h"
#include "body_private.h"

#include <string.h>

#define SBI_BODY_COOKIE 0x5b0d1u

SB_API sb_body_def sb_default_body_def(void)
{
    sb_body_def def;
    memset(&def, 0, sizeof def);
    def.integration = SB_INTEGRATION_AUTO;
    def.mass = SB_MASS_LUMPED;
    def.integrator = SB_EULER;
    def.preconditioner = SB_PRECOND_AUTO;
    def.levels = NULL;
    def.level_count = 0;
    def.tolerance = (sb_real)1e-3;
    def.max_iterations = 500;
    def.max_newton = SB_AUTO;
    def.spectral_radius = (sb_real)0.5;
    def.max_substeps = 10000;
    def.newton_tolerance = (sb_real)1e-6;
    def.cookie = SBI_BODY_COOKIE;
    return def;
}

/* ---- the observer ---- */

SBI_API void sbi_body_tell(sb_body *body, sbi_command_code code, int a, int b, const int *ints, size_t int_count,
                           const sb_real *reals, size_t real_count)
{
    sbi_command command;
    if (!body->observe)
        return;
    memset(&command, 0, sizeof command);
    command.code = code;
    command.a = a;
    command.b = b;
    command.ints = ints;
    command.int_count = int_count;
    command.reals = reals;
    command.real_count = real_count;
    body->observe(body->observer, &command);
}

SBI_API void sbi_body_tell_command(sb_body *body, const sbi_command *command)
{
    if (body->observe)
        body->observe(body->observer, command);
}

SBI_API sb_result sbi_body_check_unrecorded(const sb_body *body, sb_error *error)
{
    return body->observe ? sbi_fail(error, SB_ERROR_UNSUPPORTED, "a body that is being recorded cannot be registered: "
                                    "a replay would not know of it")
                         : SB_OK;
}

SBI_API void sbi_body_pack_material(const sb_material *material, sb_real *reals)
{
    const sb_real moduli[SBI_MATERIAL_MODULI] = {
        material->density, material->lambda, material->mu,  material->c10,             material->d1,
        material->c01,     material->c20,    material->c30, material->fibre_stiffness, material->fibre_exponent};
    memcpy(reals, moduli, sizeof moduli);
    memcpy(reals + SBI_MATERIAL_MODULI, material->prony_g, sizeof material->prony_g);
    memcpy(reals + SBI_MATERIAL_MODULI + SB_MAX_PRONY_TERMS, material->prony_tau, sizeof material->prony_tau);
}

SBI_API sb_material sbi_body_unpack_material(int model, int prony_count, const sb_real *reals)
{
    sb_material m;
    memset(&m, 0, sizeof m);
    m.model = (sb_material_model)model;
    m.prony_count = prony_count;
    m.density = reals[0];
    m.lambda = reals[1];
    m.mu = reals[2];
    m.c10 = reals[3];
    m.d1 = reals[4];
    m.c01 = reals[5];
    m.c20 = reals[6];
    m.c30 = reals[7];
    m.fibre_stiffness = reals[8];
    m.fibre_exponent = reals[9];
    memcpy(m.prony_g, reals + SBI_MATERIAL_MODULI, sizeof m.prony_g);
    memcpy(m.prony_tau, reals + SBI_MATERIAL_MODULI + SB_MAX_PRONY_TERMS, sizeof m.prony_tau);
    return m;
}

static void sbi_body_tell_material(sb_body *body, int all, int region, const sb_material *material)
{
    const int ints[3] = {region, (int)material->model, material->prony_count};
    sb_real reals[SBI_MATERIAL_REALS];
    sbi_body_pack_material(material, reals);
    sbi_body_tell(body, SBI_COMMAND_MATERIAL, all, 0, ints, 3, reals, SBI_MATERIAL_REALS);
}

/* ---- creation: arguments ---- */

SBI_API sb_result sbi_body_check_settings(const sb_body_def *def, sb_error *error)
{
    if (!sb_v3_is_finite(def->gravity))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "def.gravity is not finite");
    if (!(def->damping_mass >= 0) || !(def->damping_stiffness >= 0) || !sb_is_finite(def->damping_mass) ||
        !sb_is_finite(def->damping_stiffness))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.damping_mass %g and def.damping_stiffness %g must be >= 0",
                        (double)def->damping_mass, (double)def->damping_stiffness);
    if (!(def->tolerance > 0) || !(def->tolerance < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.tolerance %g must be in (0, 1)", (double)def->tolerance);
    if (!(def->newton_tolerance > 0) || !(def->newton_tolerance < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.newton_tolerance %g must be in (0, 1)",
                        (double)def->newton_tolerance);
    if (def->max_iterations < 1 || (def->max_newton < 1 && def->max_newton != SB_AUTO))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.max_iterations %d and def.max_newton %d must be >= 1",
                        def->max_iterations, def->max_newton);
    if (def->integrator < SB_EULER || def->integrator > SB_CENTRAL_DIFFERENCE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.integrator %d is unknown", (int)def->integrator);
    if (!(def->spectral_radius >= 0) || !(def->spectral_radius <= 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.spectral_radius %g must be in [0, 1]",
                        (double)def->spectral_radius);
    if (def->max_substeps < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.max_substeps %d must be >= 1", def->max_substeps);
    if (def->integration < SB_INTEGRATION_AUTO || def->integration > SB_INTEGRATION_BBAR)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.integration %d is unknown", (int)def->integration);
    if (def->mass != SB_MASS_LUMPED && def->mass != SB_MASS_CONSISTENT && def->mass != SB_MASS_REDUCED)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.mass %d is unknown", (int)def->mass);
    if (def->allocator.alloc && !def->allocator.release)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.allocator has alloc but no release");
    if (def->integrator == SB_CENTRAL_DIFFERENCE && def->mass != SB_MASS_LUMPED)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "SB_CENTRAL_DIFFERENCE needs def.mass SB_MASS_LUMPED");
    if (def->integrator == SB_CENTRAL_DIFFERENCE && def->damping_stiffness > 0)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "SB_CENTRAL_DIFFERENCE damps with def.damping_mass, not with def.damping_stiffness %g",
                        (double)def->damping_stiffness);
    return SB_OK;
}

SBI_API sb_result sbi_body_check_material(const sb_material *material, int single_rotation, sb_error *error)
{
    sb_result result = sb_material_check(material, error);
    if (result == SB_OK && single_rotation && material->model != SB_COROTATED)
        return sbi_fail(error, SB_ERROR_MATERIAL, "one rotation per element needs the corotated material");
    return result;
}

static sb_result sbi_body_check_def(const sb_body_def *def, sb_error *error)
{
    sb_result result;
    if (def->cookie != SBI_BODY_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by sb_default_body_def");
    if (!def->mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.mesh is NULL");
    if (def->domain && (def->integration != SB_INTEGRATION_AUTO || def->single_rotation))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "def.domain has its own points: def.integration and def.single_rotation do not go with it");
    if (def->region_material_count < 0 || (def->region_material_count > 0 && !def->region_materials))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.region_materials is NULL or its count negative");
    result = sbi_body_check_settings(def, error);
    for (int i = 0; i < def->region_material_count && result == SB_OK; i++)
        result = sbi_body_check_material(&def->region_materials[i].material, def->single_rotation, error);
    return result;
}

/* ---- creation: regions and materials ---- */

static int sbi_body_region(const sb_mesh *mesh, int element)
{
    return mesh->regions ? mesh->regions[element] : 0;
}

/* Index of a region in the ascending list, or where it would stand (then *found is 0). */
static int sbi_body_find_region(const int *regions, int count, int region, int *found)
{
    int low = 0, high = count;
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (regions[middle] < region)
            low = middle + 1;
        else
            high = middle;
    }
    *found = low < count && regions[low] == region;
    return low;
}

/* Lists the distinct regions of a mesh, ascending, in regions[capacity]; returns how many there are (counting on
 * past the capacity when it is too small, so that the caller can come back with more). */
static int sbi_body_list_regions(const sb_mesh *mesh, int *regions, int capacity)
{
    int count = 0, last = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        int region = sbi_body_region(mesh, e), found, at;
        if (e > 0 && region == last)
            continue;
        last = region;
        at = sbi_body_find_region(regions, sbi_min_int(count, capacity), region, &found);
        if (found)
            continue;
        if (count < capacity) {
            memmove(regions + at + 1, regions + at, (size_t)(count - at) * sizeof *regions);
            regions[at] = region;
        }
        count++;
    }
    return count;
}

/* Regions and materials, one material per region, and each cell's material. */
static sb_result sbi_body_make_materials(sb_body *body, const sb_body_def *def, sb_error *error)
{
    int capacity = 4, count, found;
    for (;; capacity = count) {
        sbi_free(&body->allocator, body->material_regions);
        body->material_regions = (int *)sbi_alloc(&body->allocator, (size_t)capacity, sizeof(int));
        if (!body->material_regions)
            return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d regions", capacity);
        count = sbi_body_list_regions(def->mesh, body->material_regions, capacity);
        if (count <= capacity)
            break;
    }
    body->material_count = count;
    body->materials = (sb_material *)sbi_alloc(&body->allocator, (size_t)count, sizeof(sb_material));
    body->cell_material = (int *)sbi_alloc(&body->allocator, (size_t)def->mesh->element_count, sizeof(int));
    if (!body->materials || !body->cell_material)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d materials", count);
    for (int e = 0; e < def->mesh->element_count; e++)
        body->cell_material[e] =
            sbi_body_find_region(body->material_regions, count, sbi_body_region(def->mesh, e), &found);
    for (int k = 0; k < def->region_material_count; k++) {
        for (int i = 0; i < k; i++)
            if (def->region_materials[i].region == def->region_materials[k].region)
                return sbi_fail(error, SB_ERROR_ARGUMENT, "def.region_materials names region %d twice",
                                def->region_materials[k].region);
        sbi_body_find_region(body->material_regions, count, def->region_materials[k].region, &found);
        if (!found)
            return sbi_fail(error, SB_ERROR_INDEX, "def.region_materials names region %d, which the mesh does not have",
                            def->region_materials[k].region);
    }
    for (int i = 0; i < count; i++) {
        const sb_material *material = &def->material;
        for (int k = 0; k < def->region_material_count; k++)
            if (def->region_materials[k].region == body->material_regions[i])
                material = &def->region_materials[k].material;
        sb_result result = sbi_body_check_material(material, body->domain.single_rotation, error);
        if (result != SB_OK)
            return result;
        body->materials[i] = *material;
    }
    return SB_OK;
}

/* ---- creation: fibres ---- */

/* SB_ERROR_MATERIAL naming the first element of material `index` (-1: of any), if that is to have fibres. */
static sb_result sbi_body_miss_fibres(const sb_body *body, int index, const sb_material *material, sb_error *error)
{
    for (int e = 0; e < body->domain.cell_count && material->fibre_stiffness > 0; e++)
        if (index < 0 || body->cell_material[e] == index)
            return sbi_fail_element(error, SB_ERROR_MATERIAL, e,
                                    "the material of element %d has fibres, but no directions were given (def.fibres)",
                                    e);
    return SB_OK;
}

/* Copies the directions at unit length. Scaled first, so that neither long nor short ones lose their square. */
static void sbi_body_copy_fibres(sb_vec3 *out, const sb_vec3 *fibres, int count)
{
    for (int e = 0; e < count; e++) {
        sb_vec3 a = fibres[e];
        sb_real largest = sb_max(sb_max(sb_abs(a.x), sb_abs(a.y)), sb_abs(a.z));
        if (largest > 0) {
            a = sb_v3(a.x / largest, a.y / largest, a.z / largest);
            a = sb_v3_scale(1 / sb_v3_norm(a), a);
        }
        out[e] = a;
    }
}

SB_API sb_result sb_body_set_fibres(sb_body *body, const sb_vec3 *fibres, sb_error *error)
{
    int count;
    sb_vec3 *copy;
    if (!body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_set_fibres needs a body");
    count = body->domain.cell_count;
    for (int e = 0; fibres && e < count; e++)
        if (!sb_v3_is_finite(fibres[e]))
            return sbi_fail_element(error, SB_ERROR_NOT_FINITE, e, "the fibre direction of element %d is not finite", e);
    copy = body->fibres;
    if (!fibres) {
        for (int i = 0; i < body->material_count; i++) {
            sb_result result = sbi_body_miss_fibres(body, i, body->materials + i, error);
            if (result != SB_OK)
                return result;
        }
        sbi_free(&body->allocator, copy);
        copy = NULL;
    } else if (!copy) {
        copy = (sb_vec3 *)sbi_alloc(&body->allocator, (size_t)count, sizeof *copy);
        if (!copy)
            return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the fibres of %d elements", count);
    }
    if (fibres)
        sbi_body_copy_fibres(copy, fibres, count);
    body->fibres = copy;
    body->assembly.fibres = copy;
    body->force_current = 0;
    body->acceleration_known = 0;
    sbi_body_tell(body, SBI_COMMAND_FIBRES, fibres != NULL, 0, NULL, 0, fibres ? &fibres[0].x : NULL,
                  fibres ? 3 * (size_t)count : 0);
    return SB_OK;
}

/* What a material to come, of region `index` (-1: of all), needs besides itself: fibre directions and memory. */
static sb_result sbi_body_prepare_material(sb_body *body, int index, const sb_material *material, sb_error *error)
{
    sb_result result = body->fibres ? SB_OK : sbi_body_miss_fibres(body, index, material, error);
    if (result == SB_OK)
        result = sbi_assembly_reserve_memory(&body->assembly, material->prony_count, &body->allocator, error);
    return result;
}

/* ---- creation: memory ---- */

/* Lays out every array of the body; walked once to measure and once to hand out. */
static void sbi_body_layout(sb_body *body, sbi_arena *arena)
{
    size_t n = (size_t)body->domain.node_count;
    sb_vec3 **vectors[] = {&body->reference, &body->position,     &body->displacement,  &body->velocity,
                           &body->target,    &body->dead_load,    &body->acceleration,  &body->internal,
                           &body->external,  &body->follower,     &body->equilibrated, &body->residual,      &body->rhs,
                           &body->increment, &body->reaction,     &body->velocity0,     &body->acceleration0,
                           &body->start,     &body->saved_velocity, &body->saved_acceleration,
                           &body->saved_reaction, &body->saved_external, &body->saved_internal, &body->converged,
                           &body->work,      &body->work2};
    for (size_t i = 0; i < sizeof vectors / sizeof vectors[0]; i++)
        *vectors[i] = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    body->lumped_mass = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    body->load_mass = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    body->part_scale = (sb_real *)sbi_arena_take(arena, (size_t)sbi_matrix_most_parts(body->domain.node_count),
                                                 sizeof(sb_real));
    if (body->mass_kind != SB_MASS_LUMPED)
        body->mass_blocks = (sb_real *)sbi_arena_take(arena, (size_t)body->matrix.block_count, sizeof(sb_real));
    body->fixed = (unsigned char *)sbi_arena_take(arena, n, 1);
    body->support_grams = (double(*)[36])sbi_arena_take(arena, (size_t)body->component_count, 36 * sizeof(double));
    body->component_low = (sb_vec3 *)sbi_arena_take(arena, (size_t)body->component_count, sizeof(sb_vec3));
    body->component_high = (sb_vec3 *)sbi_arena_take(arena, (size_t)body->component_count, sizeof(sb_vec3));
    body->node_component = (int *)sbi_arena_take(arena, n, sizeof(int));
    body->tie_of = (int *)sbi_arena_take(arena, (size_t)body->component_count, sizeof(int));
    sbi_assembly_layout(&body->assembly, &body->domain, body->matrix.block_count, body->material_count, arena);
}

static sb_result sbi_body_take_memory(sb_body *body, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    unsigned char *base;
    sbi_body_layout(body, &arena);
    body->memory = arena.overflow || arena.used > (size_t)-1 - 64 ? NULL
                                                                  : sbi_alloc(&body->allocator, arena.used + 64, 1);
    if (!body->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the state of %d nodes", body->domain.node_count);
    base = (unsigned char *)body->memory;
    memset(base, 0, arena.used + 64);
    arena.base = base + (64 - (size_t)((uintptr_t)base & 63));
    arena.used = 0;
    sbi_body_layout(body, &arena);
    return SB_OK;
}

/* ---- the reference shape ---- */

/* The reference mesh as others see it; borrowed arrays. */
static sb_mesh sbi_body_mesh_view(const sb_body *body)
{
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    mesh.node_count = body->domain.node_count;
    mesh.nodes = body->reference;
    mesh.element_type = body->domain.element_type;
    mesh.table = body->domain.table;
    mesh.element_count = body->domain.cell_count;
    mesh.elements = body->domain.cells;
    return mesh;
}

/* Diagonal of the bounding box (m). */
static sb_real sbi_body_size(const sb_body *body)
{
    sb_mesh mesh = sbi_body_mesh_view(body);
    sb_vec3 low, high;
    sb_mesh_bounds(&mesh, &low, &high);
    return sb_v3_norm(sb_v3_sub(high, low));
}

/* ---- mass ---- */

static void sbi_body_gather_reference(const sb_body *body, int element, sb_vec3 *x)
{
    int n = body->domain.nodes_per_cell;
    const int *cell = body->domain.cells + (size_t)element * (size_t)n;
    for (int a = 0; a < n; a++)
        x[a] = body->reference[cell[a]];
}

/* Adds the mass of one element to the matrix blocks, both sides of the diagonal. */
static void sbi_body_add_mass_blocks(const sb_body *body, int element, const sb_real *mass, sb_real density,
                                     sb_real *blocks)
{
    int n = body->domain.nodes_per_cell;
    const int *at = body->assembly.scatter + (size_t)element * (size_t)(n * (n + 1) / 2);
    for (int a = 0; a < n; a++)
        for (int b = a; b < n; b++, at++) {
            blocks[*at] += density * mass[a * n + b];
            if (a != b)
                blocks[body->matrix.transpose[*at]] += density * mass[a * n + b];
        }
}

SBI_API void sbi_body_mass_blocks(const sb_body *body, sb_mass_kind kind, sb_real *blocks)
{
    sb_real mass[SB_MAX_ELEMENT_NODES * SB_MAX_ELEMENT_NODES];
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    memset(blocks, 0, (size_t)body->matrix.block_count * sizeof *blocks);
    for (int e = 0; e < body->domain.cell_count; e++) {
        sbi_body_gather_reference(body, e, x);
        sbi_domain_element_mass(&body->domain, e, kind, x, mass, NULL);
        sbi_body_add_mass_blocks(body, e, mass, body->materials[body->cell_material[e]].density, blocks);
    }
}

/* What a part's lumped masses are to sum to and do. */
enum { SBI_SUM_MASS = 0, SBI_SUM_LEAST = 1, SBI_SUM_REST = 2, SBI_SUM_FIRST = 3, SBI_SUM_WANTED = 6, SBI_SUM_SECOND = 9 };

/* Adds to work[].x (kg) the least lumped mass that the nodes of a cell with a mass of its own should have: it may resist
 * more than it weighs, as cells do that an immersed grid's void stiffness holds. */
static void sbi_body_add_least_mass(sb_body *body, int element, const sb_vec3 *x, sb_real density)
{
    const sb_domain *domain = &body->domain;
    int n = domain->nodes_per_cell;
    const sb_real *weights = domain->weights + (size_t)element * (size_t)domain->points_per_cell;
    sb_real full[SB_MAX_ELEMENT_NODES], all = 0, volume = 0;
    sbi_domain_full_mass(domain, x, full);
    for (int a = 0; a < n; a++)
        all += full[a];
    for (int p = 0; p < sbi_body_points(body); p++)
        volume += weights[p];
    for (int a = 0; a < n; a++)
        body->work[domain->cells[(size_t)element * (size_t)n + (size_t)a]].x +=
            SBI_LEAST_MASS * density * volume * full[a] / all;
}

/* Brings nodes up to their least mass (work[].x) at the cost of the others of their part; returns 1 when there were any. */
static int sbi_body_lift_masses(sb_body *body)
{
    int n = body->domain.node_count, lifted = 0;
    memset(body->support_grams, 0, (size_t)body->component_count * sizeof body->support_grams[0]);
    for (int i = 0; i < n; i++)
        if (body->node_component[i] >= 0) {
            double *sum = body->support_grams[body->node_component[i]];
            int low = body->lumped_mass[i] < body->work[i].x;
            sum[SBI_SUM_MASS] += (double)body->lumped_mass[i];
            sum[low ? SBI_SUM_LEAST : SBI_SUM_REST] += (double)(low ? body->work[i].x : body->lumped_mass[i]);
        }
    for (int i = 0; i < n; i++)
        if (body->node_component[i] >= 0) {
            const double *sum = body->support_grams[body->node_component[i]];
            if (!(sum[SBI_SUM_LEAST] > 0) || !(sum[SBI_SUM_LEAST] < 0.5 * sum[SBI_SUM_MASS]))
                continue;
            lifted = 1;
            body->lumped_mass[i] = body->lumped_mass[i] < body->work[i].x
                                       ? body->work[i].x
                                       : (sb_real)((double)body->lumped_mass[i] *
                                                   (sum[SBI_SUM_MASS] - sum[SBI_SUM_LEAST]) / sum[SBI_SUM_REST]);
        }
    return lifted;
}

/* Sums of a part's lumped masses times 1, x and x x^T, and those of the exact first moment; x from the part's corner. */
static void sbi_body_sum_moments(sb_body *body)
{
    memset(body->support_grams, 0, (size_t)body->component_count * sizeof body->support_grams[0]);
    for (int i = 0; i < body->domain.node_count; i++)
        if (body->node_component[i] >= 0) {
            double *sum = body->support_grams[body->node_component[i]], m = (double)body->lumped_mass[i];
            sb_vec3 from = sb_v3_sub(body->reference[i], body->component_low[body->node_component[i]]);
            const double x[3] = {(double)from.x, (double)from.y, (double)from.z};
            sum[SBI_SUM_MASS] += m;
            for (int k = 0; k < 3; k++) {
                sum[SBI_SUM_FIRST + k] += m * x[k];
                sum[SBI_SUM_WANTED + k] += (double)body->load_mass[i] * x[k];
                for (int j = 0; j < 3; j++)
                    sum[SBI_SUM_SECOND + 3 * k + j] += m * x[k] * x[j];
            }
        }
}

/* Multiplies the lumped masses by 1 + tilt . (x - centre), which leaves their sum and puts their centre where the
 * material's is. Nothing where that would take a quarter of some node's mass, or the part is flat. */
static void sbi_body_tilt_masses(sb_body *body)
{
    sbi_body_sum_moments(body);
    for (int c = 0; c < body->component_count; c++) {
        double *sum = body->support_grams[c], m = sum[SBI_SUM_MASS];
        sb_vec3 size = sb_v3_sub(body->component_high[c], body->component_low[c]), shift, tilt, centre;
        sb_mat3 second;
        for (int k = 0; k < 9 && m > 0; k++)
            second.m[k / 3][k % 3] = (sb_real)((sum[SBI_SUM_SECOND + k] - sum[SBI_SUM_FIRST + k / 3] *
                                                                             sum[SBI_SUM_FIRST + k % 3] / m) / m);
        if (!(m > 0))
            continue;
        centre = sb_v3((sb_real)(sum[SBI_SUM_FIRST] / m), (sb_real)(sum[SBI_SUM_FIRST + 1] / m),
                       (sb_real)(sum[SBI_SUM_FIRST + 2] / m));
        shift = sb_v3((sb_real)((sum[SBI_SUM_WANTED] - sum[SBI_SUM_FIRST]) / m),
                      (sb_real)((sum[SBI_SUM_WANTED + 1] - sum[SBI_SUM_FIRST + 1]) / m),
                      (sb_real)((sum[SBI_SUM_WANTED + 2] - sum[SBI_SUM_FIRST + 2]) / m));
        tilt = sb_m3_apply(sb_m3_inverse(second), shift);
        memset(sum, 0, sizeof body->support_grams[0]);
        if (!(sb_abs(tilt.x) * size.x + sb_abs(tilt.y) * size.y + sb_abs(tilt.z) * size.z < (sb_real)0.25) ||
            sb_v3_norm(shift) < 64 * SB_EPSILON * sb_v3_norm(size))
            continue;
        sum[0] = (double)tilt.x, sum[1] = (double)tilt.y, sum[2] = (double)tilt.z;
        sum[3] = (double)sb_v3_dot(tilt, centre);
    }
    for (int i = 0; i < body->domain.node_count; i++)
        if (body->node_component[i] >= 0) {
            const double *tilt = body->support_grams[body->node_component[i]];
            sb_vec3 x = sb_v3_sub(body->reference[i], body->component_low[body->node_component[i]]);
            body->lumped_mass[i] *= (sb_real)(1 + tilt[0] * (double)x.x + tilt[1] * (double)x.y +
                                              tilt[2] * (double)x.z - tilt[3]);
        }
}

SBI_API void sbi_body_update_mass(sb_body *body)
{
    sb_real mass[SB_MAX_ELEMENT_NODES * SB_MAX_ELEMENT_NODES], load[SB_MAX_ELEMENT_NODES];
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    int n = body->domain.nodes_per_cell, lifted = 0;
    memset(body->lumped_mass, 0, (size_t)body->domain.node_count * sizeof(sb_real));
    memset(body->load_mass, 0, (size_t)body->domain.node_count * sizeof(sb_real));
    memset(body->work, 0, (size_t)body->domain.node_count * sizeof(sb_vec3));
    if (body->mass_blocks)
        memset(body->mass_blocks, 0, (size_t)body->matrix.block_count * sizeof(sb_real));
    for (int e = 0; e < body->domain.cell_count; e++) {
        const int *cell = body->domain.cells + (size_t)e * (size_t)n;
        sb_real density = body->materials[body->cell_material[e]].density;
        sbi_body_gather_reference(body, e, x);
        if (body->mass_blocks) {
            sbi_domain_element_mass(&body->domain, e, body->mass_kind, x, mass, load);
            sbi_body_add_mass_blocks(body, e, mass, density, body->mass_blocks);
        }
        lifted |= sbi_domain_element_mass(&body->domain, e, SB_MASS_LUMPED, x, mass, load);
        for (int a = 0; a < n; a++) {
            body->lumped_mass[cell[a]] += density * mass[a * n + a];
            body->load_mass[cell[a]] += density * load[a];
        }
        if (body->domain.cell_mass)
            sbi_body_add_least_mass(body, e, x, density);
    }
    if (body->domain.cell_mass && (sbi_body_lift_masses(body) || lifted))
        sbi_body_tilt_masses(body);
}

SBI_API void sbi_body_mass_multiply(const sb_body *body, const sb_vec3 *x, sb_vec3 *out)
{
    const sb_matrix *matrix = &body->matrix;
    for (int i = 0; i < matrix->row_count; i++) {
        sb_vec3 sum = sb_v3(0, 0, 0);
        if (!body->mass_blocks) {
            out[i] = sb_v3_scale(body->lumped_mass[i], x[i]);
            continue;
        }
        for (int k = matrix->row_start[i]; k < matrix->row_end[i]; k++)
            sum = sb_v3_madd(sum, body->mass_blocks[k], x[matrix->columns[k]]);
        out[i] = sum;
    }
}

SBI_API void sbi_body_add_mass(sb_body *body, sb_real factor)
{
    sb_matrix *matrix = &body->matrix;
    for (int i = 0; i < matrix->row_count; i++) {
        int first = body->mass_blocks ? matrix->row_start[i] : matrix->diagonal[i];
        int end = body->mass_blocks ? matrix->row_end[i] : first + 1;
        for (int k = first; k < end; k++) {
            sb_real m = factor * (body->mass_blocks ? body->mass_blocks[k] : body->lumped_mass[i]);
            matrix->blocks[k][0] += m;
            matrix->blocks[k][4] += m;
            matrix->blocks[k][8] += m;
        }
    }
}

SBI_API sb_real sbi_body_poisson(const sb_body *body)
{
    sb_real largest = -1;
    for (int k = 0; k < body->material_count; k++) {
        sb_real poisson = sb_material_poisson(body->materials + k);
        largest = poisson > largest ? poisson : largest;
    }
    return largest;
}

SBI_API sb_result sbi_body_update_precond(const sb_body *body, sb_preconditioner *precond, const sb_matrix *matrix,
                                          sb_error *error)
{
    sbi_precond_set_poisson(precond, sbi_body_poisson(body));
    return sb_preconditioner_update(precond, matrix, body->position, error);
}

SBI_API void sbi_body_materials_changed(sb_body *body)
{
    sbi_assembly_set_materials(&body->assembly, body->materials, body->material_count, body->cell_material);
    body->force_unit = body->assembly.energy_unit / sbi_body_size(body);
    sbi_body_update_mass(body);
    body->force_current = 0;
    body->acceleration_known = 0;
}

/* ---- creation: topology ---- */

/* Parts of the mesh, elements of each node, and the matrix pattern. */
static sb_result sbi_body_make_topology(sb_body *body, const sb_mesh *mesh, sb_error *error)
{
    const sb_domain *domain = &body->domain;
    sb_result result = sb_mesh_components(mesh, &body->allocator, &body->element_component, &body->component_count,
                                          error);
    if (result == SB_OK)
        result = sb_mesh_node_elements(mesh, &body->allocator, &body->node_elements, error);
    if (result == SB_OK)
        result = sb_matrix_create(domain->node_count, domain->cell_count, domain->nodes_per_cell, NULL,
                                  domain->cells, &body->allocator, &body->matrix, error);
    return result;
}

/* Grows the bounding box of a part by one of its nodes. */
static void sbi_body_grow_box(sb_body *body, int component, sb_vec3 x)
{
    sb_vec3 *low = body->component_low + component, *high = body->component_high + component;
    *low = sb_v3(sb_min(low->x, x.x), sb_min(low->y, x.y), sb_min(low->z, x.z));
    *high = sb_v3(sb_max(high->x, x.x), sb_max(high->y, x.y), sb_max(high->z, x.z));
}

/* Nodes of no element would make every system singular: they are held. Others learn their part's number. */
static void sbi_body_label_nodes(sb_body *body)
{
    const sb_index_lists *lists = &body->node_elements;
    for (int c = 0; c < body->component_count; c++) {
        body->component_low[c] = sb_v3(SB_REAL_MAX, SB_REAL_MAX, SB_REAL_MAX);
        body->component_high[c] = sb_v3(-SB_REAL_MAX, -SB_REAL_MAX, -SB_REAL_MAX);
        body->tie_of[c] = -1;
    }
    for (int i = 0; i < body->domain.node_count; i++) {
        int first = lists->offsets[i];
        int lonely = first == lists->offsets[i + 1];
        body->node_component[i] = lonely ? -1 : body->element_component.items[lists->items[first]];
        body->fixed[i] = lonely ? SB_XYZ : 0;
        if (!lonely)
            sbi_body_grow_box(body, body->node_component[i], body->reference[i]);
    }
}

/* 1 when one linearised iteration is what SB_AUTO means. Newmark has no damping of its own, so that the errors of
 * linearised steps add up until the body explodes: only a linear body may take them. */
static int sbi_body_is_one_step(const sb_body *body, sb_material_model model)
{
    return model == SB_LINEAR ||
           (body->integrator == SB_EULER && (model == SB_COROTATED || model == SB_COROTATED_INVERTIBLE));
}

SBI_API int sbi_body_max_newton(const sb_body *body)
{
    if (body->max_newton != SB_AUTO)
        return body->max_newton;
    for (int i = 0; i < body->material_count; i++)
        if (!sbi_body_is_one_step(body, body->materials[i].model))
            return 20;
    return 1;
}

/* Steps of several iterations keep the stiffness they damp with: room for it, should these materials need it. */
SBI_API sb_result sbi_body_reserve_damping(sb_body *body, const sb_material *materials, int count, sb_error *error)
{
    int needed = body->max_newton > 1;
    for (int i = 0; i < count && body->max_newton == SB_AUTO; i++)
        needed |= !sbi_body_is_one_step(body, materials[i].model);
    if (!needed || body->damping_blocks || body->integrator == SB_CENTRAL_DIFFERENCE)
        return SB_OK;
    body->damping_blocks =
        (sb_real(*)[9])sbi_alloc(&body->allocator, (size_t)body->matrix.block_count + 1, 9 * sizeof(sb_real));
    if (!body->damping_blocks)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the damping of %d blocks", body->matrix.block_count);
    return SB_OK;
}

SBI_API sb_result sbi_body_make_moduli(const sb_body *body, const sb_matrix *matrix, sb_real **moduli, sb_error *error)
{
    const sb_domain *domain = &body->domain;
    sb_real *young;
    sb_result result;
    *moduli = NULL;
    if (body->material_count < 2)
        return SB_OK;
    young = (sb_real *)sbi_alloc(&body->allocator, (size_t)domain->cell_count, sizeof(sb_real));
    *moduli = (sb_real *)sbi_alloc(&body->allocator, (size_t)matrix->block_count, sizeof(sb_real));
    if (young && *moduli) {
        for (int e = 0; e < domain->cell_count; e++)
            young[e] = sb_material_young(body->materials + body->cell_material[e]);
        result = sb_preconditioner_moduli(matrix, domain->cell_count, domain->nodes_per_cell, domain->cells, young,
                                          *moduli, error);
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the moduli of %d blocks", matrix->block_count);
    }
    sbi_free(&body->allocator, young);
    if (result != SB_OK) {
        sbi_free(&body->allocator, *moduli);
        *moduli = NULL;
    }
    return result;
}

static sb_result sbi_body_make_preconditioner(sb_body *body, const sb_body_def *def, sb_error *error)
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
        result = sbi_body_make_moduli(body, &body->matrix, &moduli, error);
    settings.moduli = moduli;
    if (result == SB_OK)
        result = sb_preconditioner_create(&settings, &body->matrix, &body->allocator, &body->precond, error);
    sbi_free(&body->allocator, moduli);
    return result;
}

static sb_result sbi_body_build(sb_body *body, const sb_body_def *def, sb_error *error)
{
    const sb_allocator *allocator = &body->allocator;
    uint64_t *node_colours;
    sb_result result = def->domain ? sbi_domain_copy(def->domain, def->mesh, allocator, &body->domain, error)
                                   : sb_domain_create(def->mesh, def->integration, def->single_rotation, allocator,
                                                      &body->domain, error);
    body->own_points = def->domain != NULL;
    if (result == SB_OK)
        result = sbi_body_make_materials(body, def, error);
    if (result == SB_OK)
        result = sbi_body_make_topology(body, def->mesh, error);
    if (result == SB_OK)
        result = sbi_body_take_memory(body, error);
    if (result == SB_OK)
        result = sbi_body_make_preconditioner(body, def, error);
    if (result == SB_OK)
        result = sb_pcg_workspace_create(body->domain.node_count, allocator, &body->pcg, error);
    if (result != SB_OK)
        return result;
    node_colours = (uint64_t *)sbi_alloc(allocator, (size_t)body->domain.node_count, sizeof *node_colours);
    if (!node_colours)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory to colour %d nodes", body->domain.node_count);
    body->assembly.jobs = &body->jobs;
    body->assembly.reference = body->reference;
    sbi_assembly_prepare(&body->assembly, &body->matrix, node_colours);
    sbi_free(allocator, node_colours);
    memcpy(body->reference, def->mesh->nodes, (size_t)body->domain.node_count * sizeof(sb_vec3));
    sbi_body_label_nodes(body);
    result = def->fibres ? sb_body_set_fibres(body, def->fibres, error) : SB_OK;
    for (int i = 0; i < body->material_count && result == SB_OK; i++)
        result = sbi_body_prepare_material(body, i, body->materials + i, error);
    if (result != SB_OK)
        return result;
    sbi_body_materials_changed(body);
    sb_body_reset(body);
    return sbi_body_reserve_damping(body, body->materials, body->material_count, error);
}

SB_API sb_result sb_body_create(const sb_body_def *def, sb_body **body, sb_error *error)
{
    sb_body *made;
    sb_result result;
    if (!def || !body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_create needs a def and a place for the body");
    result = sbi_body_check_def(def, error);
    if (result != SB_OK)
        return result;
    made = (sb_body *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a body");
    made->allocator = def->allocator;
    made->jobs = def->jobs;
    made->clock = def->clock;
    made->mass_kind = def->mass;
    made->integrator = def->integrator;
    made->gravity = def->gravity;
    made->damping_mass = def->damping_mass;
    made->damping_stiffness = def->damping_stiffness;
    made->tolerance = def->tolerance;
    made->newton_tolerance = def->newton_tolerance;
    made->max_iterations = def->max_iterations;
    made->max_newton = def->max_newton;
    made->spectral_radius = def->spectral_radius;
    made->max_substeps = def->max_substeps;
    result = sbi_body_build(made, def, error);
    if (result != SB_OK) {
        sb_body_destroy(made);
        return result;
    }
    *body = made;
    return SB_OK;
}

SB_API void sb_body_destroy(sb_body *body)
{
    sb_allocator allocator;
    if (!body)
        return;
    sbi_body_tell(body, SBI_COMMAND_DESTROY, 0, 0, NULL, 0, NULL, 0);
    allocator = body->allocator;
    for (int i = 0; i < body->load_count; i++)
        sbi_free(&allocator, body->loads[i].memory);
    sbi_free(&allocator, body->loads);
    sbi_free(&allocator, body->tie_gram);
    sbi_elimination_free(body->elimination);
    sb_pcg_workspace_free(&body->pcg);
    sb_preconditioner_free(body->precond);
    sb_matrix_free(&body->matrix);
    sb_index_table_free(&body->element_component);
    sb_index_lists_free(&body->node_elements);
    sbi_assembly_free_memory(&body->assembly, &allocator);
    sb_domain_free(&body->domain);
    sbi_free(&allocator, body->fibres);
    sbi_free(&allocator, body->support_blocks);
    sbi_free(&allocator, body->damping_blocks);
    sbi_free(&allocator, body->extra_start);
    sbi_free(&allocator, body->pattern_memory);
    sbi_free(&allocator, body->cell_material);
    sbi_free(&allocator, body->materials);
    sbi_free(&allocator, body->material_regions);
    sbi_free(&allocator, body->memory);
    sbi_free(&allocator, body);
}

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

/* The matrix of elements and rows together. */
static sb_result sbi_body_make_extended_matrix(const sb_body *body, sbi_body_pattern *pattern, sb_error *error)
{
    const sb_domain *domain = &body->domain;
    size_t n = (size_t)domain->nodes_per_cell, own = (size_t)domain->cell_count * n;
    size_t extra = (size_t)pattern->extra_start[pattern->extra_count], bytes = 0;
    size_t cells = (size_t)domain->cell_count + (size_t)pattern->extra_count;
    int *start = NULL, *nodes;
    sb_result result;
    if (own + extra <= INT32_MAX && cells < INT32_MAX && sbi_size_add(&bytes, cells + 1, sizeof(int)) &&
        sbi_size_add(&bytes, own + extra, sizeof(int)))
        start = (int *)sbi_alloc(&body->allocator, bytes, 1);
    if (!start)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the couplings of %d rows", pattern->extra_count);
    nodes = start + cells + 1;
    for (int e = 0; e < domain->cell_count; e++)
        start[e] = e * domain->nodes_per_cell;
    for (int c = 0; c <= pattern->extra_count; c++)
        start[domain->cell_count + c] = (int)own + pattern->extra_start[c];
    memcpy(nodes, domain->cells, own * sizeof(int));
    memcpy(nodes + own, pattern->extra_nodes, extra * sizeof(int));
    result = sb_matrix_create(domain->node_count, (int)cells, 0, start, nodes, &body->allocator, &pattern->matrix,
                              error);
    sbi_free(&body->allocator, start);
    return result;
}

/* Takes the arrays of one entry per block from the arena (measuring or for real). */
static void sbi_body_pattern_layout(const sb_body *body, sbi_body_pattern *pattern, sbi_arena *arena)
{
    size_t blocks = (size_t)pattern->matrix.block_count;
    if (body->mass_blocks)
        pattern->mass_blocks = (sb_real *)sbi_arena_take(arena, blocks, sizeof(sb_real));
    if (sbi_assembly_has_pairs(&body->assembly))
        pattern->pair_start = (int *)sbi_arena_take(arena, blocks + 1, sizeof(int));
}

static sb_result sbi_body_make_block_arrays(const sb_body *body, const unsigned char *fixed, sbi_body_pattern *pattern,
                                            sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    int most = pattern->matrix.block_count;
    const int *row_start = pattern->matrix.row_start, *row_end = pattern->matrix.row_end;
    sbi_body_pattern_layout(body, pattern, &arena);
    pattern->memory = arena.overflow ? NULL : sbi_alloc(&body->allocator, arena.used, 1);
    for (int i = 0; i < body->domain.node_count; i++)
        if (fixed[i] && body->node_component[i] >= 0)
            pattern->support_used += row_end[i] - row_start[i];
    pattern->support_capacity = body->support_capacity;
    if (pattern->support_used > body->support_capacity) {
        pattern->support_capacity = sbi_min_int(most - pattern->support_used, pattern->support_used / 2) +
                                    pattern->support_used;
        pattern->support_blocks =
            sbi_alloc(&body->allocator, (size_t)pattern->support_capacity, 9 * sizeof(sb_real));
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
    sb_result result = sbi_body_make_extended_matrix(body, pattern, error);
    if (result == SB_OK)
        result = sbi_body_make_block_arrays(body, fixed, pattern, error);
    if (result == SB_OK)
        result = sbi_precond_remake(body->precond, &pattern->matrix, body->reference, &body->allocator,
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
    memset(pattern, 0, sizeof *pattern);
}

SBI_API sb_result sbi_body_extend_pattern(sb_body *body, int cell_count, const int *cell_start, const int *cells,
                                          sb_error *error)
{
    sbi_body_pattern pattern;
    sb_result result = sbi_body_make_pattern(body, cell_count, cell_start, cells, &pattern, error);
    if (result == SB_OK)
        sbi_body_take_pattern(body, &pattern);
    return result;
}

/* ---- sizes ---- */

SB_API int sb_body_node_count(const sb_body *body) { return body ? body->domain.node_count : 0; }
SB_API int sb_body_element_count(const sb_body *body) { return body ? body->domain.cell_count : 0; }
SB_API int sb_body_point_count(const sb_body *body) { return body ? sbi_body_points(body) : 0; }
SB_API sb_preconditioner_info sb_body_solver(const sb_body *body)
{
    sb_preconditioner_info none;
    if (!body) {
        memset(&none, 0, sizeof none);
        return none;
    }
    return sb_preconditioner_get_info(body->elimination ? body->elimination->precond : body->precond);
}
SB_API int sb_body_matrix_blocks(const sb_body *body) { return body ? body->matrix.block_count : 0; }

/* ---- properties ---- */

SB_API sb_result sb_body_set_material(sb_body *body, const sb_material *material, sb_error *error)
{
    sb_result result;
    if (!body || !material)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_set_material needs a body and a material");
    result = sbi_body_check_material(material, body->domain.single_rotation, error);
    if (result == SB_OK)
        result = sbi_body_prepare_material(body, -1, material, error);
    if (result == SB_OK)
        result = sbi_body_reserve_damping(body, material, 1, error);
    if (result != SB_OK)
        return result;
    for (int i = 0; i < body->material_count; i++)
        body->materials[i] = *material;
    sbi_body_materials_changed(body);
    sbi_assembly_forget(&body->assembly, -1, body->displacement);
    sbi_body_tell_material(body, 1, 0, material);
    return SB_OK;
}

SB_API sb_result sb_body_set_region_material(sb_body *body, int region, const sb_material *material,
                                             sb_error *error)
{
    sb_result result;
    int at, found;
    if (!body || !material)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_set_region_material needs a body and a material");
    at = sbi_body_find_region(body->material_regions, body->material_count, region, &found);
    if (!found)
        return sbi_fail(error, SB_ERROR_INDEX, "the mesh has no region %d", region);
    result = sbi_body_check_material(material, body->domain.single_rotation, error);
    if (result == SB_OK)
        result = sbi_body_prepare_material(body, at, material, error);
    if (result == SB_OK)
        result = sbi_body_reserve_damping(body, material, 1, error);
    if (result != SB_OK)
        return result;
    body->materials[at] = *material;
    sbi_body_materials_changed(body);
    sbi_assembly_forget(&body->assembly, at, body->displacement);
    sbi_body_tell_material(body, 0, region, material);
    return SB_OK;
}

SB_API sb_result sb_body_set_gravity(sb_body *body, sb_vec3 gravity)
{
    if (!body)
        return SB_ERROR_ARGUMENT;
    if (!sb_v3_is_finite(gravity))
        return SB_ERROR_NOT_FINITE;
    body->gravity = gravity;
    sbi_body_tell(body, SBI_COMMAND_GRAVITY, 0, 0, NULL, 0, &gravity.x, 3);
    return SB_OK;
}

SB_API sb_result sb_body_set_damping(sb_body *body, sb_real alpha, sb_real beta)
{
    const sb_real damping[2] = {alpha, beta};
    if (!body || !(alpha >= 0) || !(beta >= 0) || !sb_is_finite(alpha) || !sb_is_finite(beta))
        return SB_ERROR_ARGUMENT;
    if (body->integrator == SB_CENTRAL_DIFFERENCE && beta > 0)
        return SB_ERROR_UNSUPPORTED;
    body->damping_mass = alpha;
    body->damping_stiffness = beta;
    sbi_body_tell(body, SBI_COMMAND_DAMPING, 0, 0, NULL, 0, damping, 2);
    return SB_OK;
}

SB_API sb_result sb_body_set_solver(sb_body *body, sb_real tolerance, int max_iterations)
{
    if (!body || !(tolerance > 0) || !(tolerance < 1) || max_iterations < 1)
        return SB_ERROR_ARGUMENT;
    body->tolerance = tolerance;
    body->max_iterations = max_iterations;
    sbi_body_tell(body, SBI_COMMAND_SOLVER, max_iterations, 0, NULL, 0, &tolerance, 1);
    return SB_OK;
}

/* ---- faces ---- */

/* 1 when the named corners of an element (all different) are those of the list. */
static int sbi_body_has_corners(const int *list, const int *cell, const int *local, int count)
{
    int found = 0;
    for (int k = 0; k < count; k++)
        for (int i = 0; i < count; i++)
            if (cell[local[k]] == list[i]) {
                found++;
                break;
            }
    return found == count;
}

/* 1 when the corners of b go round the other way than those of a. */
static int sbi_body_is_reversed(const int *a, const int *b, int corners)
{
    for (int i = 0; i < corners; i++)
        if (b[i] == a[0])
            return b[(i + 1) % corners] != a[1];
    return 0;
}

/* Finds the element face with these corner nodes; 0 when there is none. */
static int sbi_body_find_face(const sb_body *body, const int *corners, int count, sbi_body_face *found)
{
    const sb_index_lists *lists = &body->node_elements;
    sbi_element element = sbi_domain_element(&body->domain);
    int n = body->domain.nodes_per_cell;
    memset(found, 0, sizeof *found);
    for (int k = lists->offsets[corners[0]]; k < lists->offsets[corners[0] + 1]; k++) {
        const int *cell = body->domain.cells + (size_t)lists->items[k] * (size_t)n;
        for (int face = 0; face < sbi_element_face_count(element); face++) {
            int local[SB_MAX_FACE_NODES], nodes[SB_MAX_FACE_NODES];
            sb_element_type face_type = SB_NO_ELEMENT;
            int face_nodes = sbi_element_face(element, face, local, &face_type);
            if (sb_element_corner_count(face_type) != count || !sbi_body_has_corners(corners, cell, local, count))
                continue;
            for (int i = 0; i < face_nodes; i++)
                nodes[i] = cell[local[i]];
            if (found->count) {
                found->inner |= sbi_body_is_reversed(found->nodes, nodes, count);
                continue;
            }
            found->type = face_type;
            found->count = face_nodes;
            memcpy(found->nodes, nodes, (size_t)face_nodes * sizeof *nodes);
        }
    }
    return found->count > 0;
}

SBI_API sb_result sbi_body_get_face(const sb_body *body, const int *faces, int f, int corners, sbi_body_face *found,
                                   sb_error *error)
{
    const int *face = faces + (size_t)f * (size_t)corners;
    found->count = 0;
    for (int k = 0; k < corners; k++)
        if (sbi_body_check_nodes(body, face + k, 1) != SB_OK)
            return sbi_fail_node(error, SB_ERROR_INDEX, face[k], "face %d has node %d, which is outside the mesh", f,
                                 face[k]);
    if (!sbi_body_find_face(body, face, corners, found))
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, face[0], "face %d (nodes %d %d %d ...) is no face of an element",
                             f, face[0], face[1], face[2]);
    return SB_OK;
}

/* ---- supports ---- */

SBI_API sb_result sbi_body_check_nodes(const sb_body *body, const int *nodes, int count)
{
    if (!body || count < 0 || (count > 0 && !nodes))
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < count; i++)
        if (nodes[i] < 0 || nodes[i] >= body->domain.node_count)
            return SB_ERROR_INDEX;
    return SB_OK;
}

static int sbi_body_row_length(const sb_body *body, int node)
{
    return body->matrix.row_end[node] - body->matrix.row_start[node];
}

SBI_API sb_result sbi_body_reserve_support_blocks(sb_body *body, int needed)
{
    int most = body->matrix.block_count, capacity;
    void *blocks;
    if (needed <= body->support_capacity)
        return SB_OK;
    capacity = needed > most / 2 ? most : needed + needed / 2;
    blocks = sbi_alloc(&body->allocator, (size_t)capacity, 9 * sizeof(sb_real));
    if (!blocks)
        return SB_ERROR_MEMORY;
    sbi_free(&body->allocator, body->support_blocks);
    body->support_blocks = (sb_real(*)[9])blocks;
    body->support_capacity = capacity;
    return SB_OK;
}

/* Room for the tangent rows of the supports to come: reactions are read from them. The count is an upper bound (a
 * node listed twice counts twice). */
static sb_result sbi_body_reserve_supports(sb_body *body, const int *nodes, int count)
{
    int needed = body->support_used, most = body->matrix.block_count;
    for (int i = 0; i < count; i++)
        if (!body->fixed[nodes[i]])
            needed += sbi_min_int(sbi_body_row_length(body, nodes[i]), most - needed);
    return sbi_body_reserve_support_blocks(body, needed);
}

SBI_API sb_vec3 sbi_body_pick_axes(unsigned axes, sb_vec3 value, sb_vec3 otherwise)
{
    return sb_v3(axes & SB_X ? value.x : otherwise.x, axes & SB_Y ? value.y : otherwise.y,
                 axes & SB_Z ? value.z : otherwise.z);
}

/* Supports axes of the nodes with target targets[i * stride], or where they are now when targets is NULL. */
static sb_result sbi_body_support(sb_body *body, const int *nodes, int count, int axes, const sb_vec3 *targets,
                                  int stride)
{
    sb_result result = sbi_body_check_nodes(body, nodes, count);
    if (result != SB_OK)
        return result;
    if (axes < 0 || axes > SB_XYZ)
        return SB_ERROR_ARGUMENT;
    if (axes == 0)
        return SB_OK;
    for (int i = 0; i < count && body->elimination; i++)
        if (body->elimination->slave[nodes[i]] & axes)
            return SB_ERROR_ARGUMENT;
    result = sbi_body_reserve_supports(body, nodes, count);
    for (int i = 0; i < count && result == SB_OK; i++) {
        int node = nodes[i];
        if (!body->fixed[node])
            body->support_used += sbi_body_row_length(body, node);
        body->fixed[node] |= (unsigned char)axes;
        body->target[node] = sbi_body_pick_axes((unsigned)axes, targets ? targets[i * stride] : body->displacement[node],
                                                body->target[node]);
    }
    if (body->elimination) /* masses of slaves go to other nodes now */
        body->guard.stable_step = 0;
    if (result == SB_OK && !targets)
        sbi_body_tell(body, SBI_COMMAND_FIX, axes, 0, nodes, (size_t)count, NULL, 0);
    else if (result == SB_OK && count > 0)
        sbi_body_tell(body, SBI_COMMAND_PRESCRIBE, axes, stride == 0, nodes, (size_t)count, &targets[0].x,
                      stride == 0 ? 3 : 3 * (size_t)count);
    return result;
}

SB_API sb_result sb_body_fix_nodes(sb_body *body, const int *nodes, int count, int axes)
{
    return sbi_body_support(body, nodes, count, axes, NULL, 0);
}

SB_API sb_result sb_body_prescribe(sb_body *body, const int *nodes, int count, int axes,
                                   const sb_vec3 *displacements, int uniform)
{
    if (!body || count < 0 || (count > 0 && !displacements))
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < (uniform ? sbi_min_int(count, 1) : count); i++)
        if (!sb_v3_is_finite(displacements[i]))
            return SB_ERROR_NOT_FINITE;
    return sbi_body_support(body, nodes, count, axes, displacements, uniform ? 0 : 1);
}

SB_API sb_result sb_body_release_nodes(sb_body *body, const int *nodes, int count, int axes)
{
    sb_result result = sbi_body_check_nodes(body, nodes, count);
    if (result != SB_OK)
        return result;
    if (axes < 0 || axes > SB_XYZ)
        return SB_ERROR_ARGUMENT;
    if (body->elimination)
        body->guard.stable_step = 0;
    for (int i = 0; i < count; i++)
        if (body->node_component[nodes[i]] >= 0) {
            int held = body->fixed[nodes[i]];
            body->fixed[nodes[i]] &= (unsigned char)~axes;
            if (held && !body->fixed[nodes[i]])
                body->support_used -= sbi_body_row_length(body, nodes[i]);
            body->reaction[nodes[i]] =
                sbi_body_pick_axes((unsigned)axes, sb_v3(0, 0, 0), body->reaction[nodes[i]]);
        }
    sbi_body_tell(body, SBI_COMMAND_RELEASE, axes, 0, nodes, (size_t)count, NULL, 0);
    return SB_OK;
}

SB_API const unsigned char *sb_body_supports(const sb_body *body) { return body ? body->fixed : NULL; }

/* ---- state ---- */

SB_API const sb_vec3 *sb_body_positions(const sb_body *body) { return body ? body->position : NULL; }
SB_API const sb_vec3 *sb_body_displacements(const sb_body *body) { return body ? body->displacement : NULL; }
SB_API const sb_vec3 *sb_body_velocities(const sb_body *body) { return body ? body->velocity : NULL; }
SB_API const sb_vec3 *sb_body_reactions(const sb_body *body) { return body ? body->reaction : NULL; }
SB_API const sb_vec3 *sb_body_external_forces(const sb_body *body) { return body ? body->external : NULL; }

static int sbi_body_all_finite(const sb_vec3 *values, int count)
{
    for (int i = 0; i < count; i++)
        if (!sb_v3_is_finite(values[i]))
            return 0;
    return 1;
}

SBI_API void sbi_body_update_positions(sb_body *body)
{
    for (int i = 0; i < body->domain.node_count; i++)
        body->position[i] = sb_v3_add(body->reference[i], body->displacement[i]);
}

SB_API sb_result sb_body_set_displacements(sb_body *body, const sb_vec3 *displacements)
{
    if (!body || !displacements)
        return SB_ERROR_ARGUMENT;
    if (!sbi_body_all_finite(displacements, body->domain.node_count))
        return SB_ERROR_NOT_FINITE;
    memmove(body->displacement, displacements, (size_t)body->domain.node_count * sizeof(sb_vec3));
    sbi_body_update_positions(body);
    body->force_current = 0;
    body->acceleration_known = 0;
    sbi_body_tell(body, SBI_COMMAND_DISPLACEMENTS, 0, 0, NULL, 0, &body->displacement[0].x,
                  3 * (size_t)body->domain.node_count);
    return SB_OK;
}

SB_API sb_result sb_body_set_velocities(sb_body *body, const sb_vec3 *velocities)
{
    if (!body || !velocities)
        return SB_ERROR_ARGUMENT;
    if (!sbi_body_all_finite(velocities, body->domain.node_count))
        return SB_ERROR_NOT_FINITE;
    memmove(body->velocity, velocities, (size_t)body->domain.node_count * sizeof(sb_vec3));
    body->acceleration_known = 0;
    sbi_body_tell(body, SBI_COMMAND_VELOCITIES, 0, 0, NULL, 0, &body->velocity[0].x,
                  3 * (size_t)body->domain.node_count);
    return SB_OK;
}

/* The load has taken part in no solve. */
static void sbi_body_reset_load(sbi_load *load)
{
    load->balanced = 0; /* the balanced values mean nothing now, nor does a saved state have them */
    load->balanced_pressure = 0;
    memset(load->net, 0, sizeof load->net);
    if (load->force)
        memset(load->force, 0, (size_t)load->row_count * sizeof *load->force);
}

SB_API void sb_body_reset(sb_body *body)
{
    size_t bytes = (size_t)sb_body_node_count(body) * sizeof(sb_vec3);
    if (!body)
        return;
    memset(body->displacement, 0, bytes);
    memset(body->velocity, 0, bytes);
    memset(body->acceleration, 0, bytes);
    memset(body->reaction, 0, bytes);
    memset(body->external, 0, bytes);
    memset(body->equilibrated, 0, bytes);
    for (int i = 0; i < body->load_count; i++)
        sbi_body_reset_load(body->loads + i);
    if (body->elimination)
        memset(body->elimination->force, 0, (size_t)body->elimination->equations.count * sizeof(sb_real));
    sbi_assembly_reset_rotations(&body->assembly);
    sbi_assembly_forget(&body->assembly, -1, body->displacement);
    sbi_body_update_positions(body);
    body->force_current = 0;
    body->acceleration_known = 0;
    sbi_body_tell(body, SBI_COMMAND_RESET, 0, 0, NULL, 0, NULL, 0);
}

/* ---- readings ---- */

SBI_API sb_vec3 sbi_body_row_value(const sbi_load *load, int row, const sb_vec3 *u)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int k = load->row_start[row]; k < load->row_start[row + 1]; k++)
        sum = sb_v3_madd(sum, load->weights[k], u[load->nodes[k]]);
    return sum;
}

/* sum over the rows of k |H^T u - target|^2 / 2. */
static sb_real sbi_body_load_energy(const sb_body *body, const sbi_load *load)
{
    sb_real sum = 0;
    for (int j = 0; load->kind != SBI_LOAD_PRESSURE && j < load->row_count; j++) {
        sb_vec3 stretch = sb_v3_sub(sbi_body_row_value(load, j, body->displacement), load->target[j]);
        sum += (sb_real)0.5 * load->stiffness[j] * sb_v3_dot(stretch, stretch);
    }
    return sum;
}

SB_API sb_result sb_body_energy(sb_body *body, sb_energy *energy)
{
    sb_energy sum = {0, 0, 0};
    int bad;
    if (!body || !energy)
        return SB_ERROR_ARGUMENT;
    sbi_assembly_begin_step(&body->assembly, (sb_real)INFINITY);
    bad = sbi_assembly_energy(&body->assembly, body->displacement, &sum.elastic);
    sbi_assembly_begin_step(&body->assembly, 0);
    if (bad >= 0)
        return SB_ERROR_INVERTED;
    sbi_body_mass_multiply(body, body->velocity, body->work);
    for (int i = 0; i < body->domain.node_count; i++)
        sum.kinetic += (sb_real)0.5 * sb_v3_dot(body->velocity[i], body->work[i]);
    for (int i = 0; i < body->load_count; i++)
        sum.springs += sbi_body_load_energy(body, body->loads + i);
    if (!sb_is_finite(sum.elastic) || !sb_is_finite(sum.kinetic) || !sb_is_finite(sum.springs))
        return SB_ERROR_NOT_FINITE;
    *energy = sum;
    return SB_OK;
}

/* y = K x; -1, or the first cell without a tangent. */
static int sbi_body_tangent_product(sb_body *body, sb_tangent_kind kind, const sb_vec3 *x, sb_vec3 *y)
{
    int bad;
    if (kind == SB_TANGENT_QUASI && sbi_assembly_multiply(&body->assembly, x, y))
        return -1;
    bad = sbi_assembly_tangent(&body->assembly, body->displacement, kind, 1, &body->matrix);
    if (bad < 0)
        sb_matrix_multiply(&body->matrix, &x[0].x, &y[0].x, &body->jobs);
    return bad;
}

SB_API sb_result sb_body_multiply_tangent(sb_body *body, sb_tangent_kind kind, const sb_vec3 *x, sb_vec3 *y,
                                          sb_error *error)
{
    int bad = -1, has_rotations;
    if (!body || !x || !y)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a product with the stiffness needs a body, x and y");
    if (kind != SB_TANGENT_EXACT && kind != SB_TANGENT_SPD && kind != SB_TANGENT_QUASI)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the kind of tangent %d is unknown", (int)kind);
    for (int i = 0; i < body->domain.node_count; i++)
        if (!sb_v3_is_finite(x[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "the displacement of node %d is not finite", i);
    has_rotations = body->force_current;
    if (!has_rotations) { /* forces leave traces in the warm starts */
        sbi_assembly_save_rotations(&body->assembly);
        bad = sbi_assembly_force(&body->assembly, body->displacement, body->work);
    }
    if (bad < 0)
        bad = sbi_body_tangent_product(body, kind, x, body->work2);
    if (!has_rotations)
        sbi_assembly_restore_rotations(&body->assembly);
    if (bad >= 0)
        return sbi_fail_element(error, SB_ERROR_INVERTED, bad,
                                "element %d is inside out, which its material does not allow", bad);
    memcpy(y, body->work2, (size_t)body->domain.node_count * sizeof *y);
    return SB_OK;
}

SB_API sb_result sb_body_multiply_stiffness(sb_body *body, const sb_vec3 *x, sb_vec3 *y, sb_error *error)
{
    return sb_body_multiply_tangent(body, SB_TANGENT_EXACT, x, y, error);
}

SB_API sb_real sb_body_mass(const sb_body *body)
{
    sb_real sum = 0;
    if (!body)
        return 0;
    for (int i = 0; i < body->domain.node_count; i++)
        sum += body->lumped_mass[i];
    return sum;
}

SB_API sb_vec3 sb_body_momentum(const sb_body *body)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    if (!body)
        return sb_v3(0, 0, 0);
    for (int i = 0; i < body->domain.node_count; i++)
        sum = sb_v3_madd(sum, body->mass_blocks ? body->load_mass[i] : body->lumped_mass[i], body->velocity[i]);
    return sum;
}

/* Cauchy stresses at the points of an element; 0, and admissible[point] 0, where there is none. */
static void sbi_body_element_stresses(const sb_body *body, int element, sb_mat3 *stress, int *admissible)
{
    const sb_material *material = body->materials + body->cell_material[element];
    sb_mat3 f[SB_MAX_QUADRATURE_POINTS], p[SB_MAX_QUADRATURE_POINTS];
    int mean = body->domain.points_per_cell - 1;
    sbi_assembly_points(&body->assembly, body->displacement, element, f, p, admissible);
    for (int i = mean; i >= 0; i--) {
        if (material->model != SB_LINEAR && sb_m3_det(f[i]) == 0)
            admissible[i] = 0;
        if (admissible[i])
            stress[i] = sb_material_cauchy_stress(material, f[i], p[i]);
        if (body->domain.mean_point && i < mean) { /* its share of the stress belongs to every point */
            admissible[i] &= admissible[mean];
            stress[i] = sb_m3_add(stress[i], stress[mean]);
        }
        if (!admissible[i] || !sb_is_finite(sb_von_mises(stress[i]))) { /* beyond what sb_real holds, too */
            stress[i] = sb_m3_zero();
            admissible[i] = 0;
        }
    }
}

SB_API sb_result sb_body_stress(const sb_body *body, int element, int point, sb_mat3 *stress)
{
    sb_mat3 all[SB_MAX_QUADRATURE_POINTS];
    int admissible[SB_MAX_QUADRATURE_POINTS];
    if (!body || !stress)
        return SB_ERROR_ARGUMENT;
    if (element < 0 || element >= body->domain.cell_count || point < 0 || point >= sbi_body_points(body))
        return SB_ERROR_INDEX;
    sbi_body_element_stresses(body, element, all, admissible);
    if (!admissible[point])
        return SB_ERROR_INVERTED;
    *stress = all[point];
    return SB_OK;
}

static sb_real sbi_body_element_volume(const sb_body *body, int element)
{
    sb_real sum = 0;
    int q = body->domain.points_per_cell;
    for (int p = 0; p < sbi_body_points(body); p++)
        sum += body->domain.weights[(size_t)element * (size_t)q + (size_t)p];
    return sum;
}

static sb_real sbi_body_element_von_mises(const sb_body *body, int element)
{
    sb_mat3 stress[SB_MAX_QUADRATURE_POINTS];
    int admissible[SB_MAX_QUADRATURE_POINTS];
    const sb_real *weights = body->domain.weights + (size_t)element * (size_t)body->domain.points_per_cell;
    sb_real sum = 0;
    sbi_body_element_stresses(body, element, stress, admissible);
    for (int p = 0; body->own_points && p < sbi_body_points(body); p++)
        sum += weights[p] * sb_von_mises(stress[p]);
    if (body->own_points) {
        sb_real volume = sbi_body_element_volume(body, element);
        return volume > 0 ? sum / volume : 0;
    }
    for (int p = 0; p < sbi_body_points(body); p++)
        sum += sb_von_mises(stress[p]);
    return sum / (sb_real)sbi_body_points(body);
}

SB_API void sb_body_von_mises(const sb_body *body, sb_real *values)
{
    if (!body || !values)
        return;
    for (int e = 0; e < body->domain.cell_count; e++)
        values[e] = sbi_body_element_von_mises(body, e);
}

SB_API void sb_body_nodal_von_mises(const sb_body *body, sb_real *values)
{
    const sb_domain *domain;
    const sb_index_lists *lists;
    if (!body || !values)
        return;
    domain = &body->domain;
    lists = &body->node_elements;
    for (int i = 0; i < domain->node_count; i++)
        values[i] = 0;
    for (int e = 0; e < domain->cell_count; e++) {
        sb_real value = sbi_body_element_von_mises(body, e) * sbi_body_element_volume(body, e);
        for (int a = 0; a < domain->nodes_per_cell; a++)
            values[domain->cells[(size_t)e * (size_t)domain->nodes_per_cell + (size_t)a]] += value;
    }
    for (int i = 0; i < domain->node_count; i++) {
        sb_real volume = 0;
        for (int k = lists->offsets[i]; k < lists->offsets[i + 1]; k++)
            volume += sbi_body_element_volume(body, lists->items[k]);
        values[i] = volume > 0 ? values[i] / volume : 0;
    }
}

/* ---- how nodes turned ---- */

/* Rows of the sum of w F over the points around each node, which has the rotation of their mean. */
static void sbi_body_sum_gradients(const sb_body *body, sb_vec3 *rows[3])
{
    const sb_domain *domain = &body->domain;
    int width = domain->nodes_per_cell;
    for (int r = 0; r < 3; r++)
        memset(rows[r], 0, (size_t)domain->node_count * sizeof(sb_vec3));
    for (int e = 0; e < domain->cell_count; e++) {
        const int *nodes = domain->cells + (size_t)e * (size_t)width;
        sb_vec3 f[3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
        for (int p = 0; p < sbi_body_points(body); p++) {
            size_t point = (size_t)e * (size_t)domain->points_per_cell + (size_t)p;
            const sb_real *g = domain->gradients + 3 * (size_t)width * point;
            for (int a = 0; a < width; a++, g += 3) {
                sb_vec3 x = sb_v3_scale(domain->weights[point], body->position[nodes[a]]), slope = sb_v3(g[0], g[1], g[2]);
                f[0] = sb_v3_madd(f[0], x.x, slope);
                f[1] = sb_v3_madd(f[1], x.y, slope);
                f[2] = sb_v3_madd(f[2], x.z, slope);
            }
        }
        for (int a = 0; a < width; a++)
            for (int r = 0; r < 3; r++)
                rows[r][nodes[a]] = sb_v3_add(rows[r][nodes[a]], f[r]);
    }
}

typedef struct sbi_body_turning {
    sb_vec3 *rows[3];
    sb_quat *rotations;
    int count;
} sbi_body_turning;

/* Rotations of SB_POLAR_LANES nodes; unused lanes repeat the last node, and a node without material does not turn. */
static void sbi_body_turn_batch(const sbi_body_turning *t, int first)
{
    sb_real f[9][SB_POLAR_LANES], q[4][SB_POLAR_LANES], r[9][SB_POLAR_LANES];
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        int i = sbi_min_int(first + l, t->count - 1);
        sb_real sum = 0;
        for (int k = 0; k < 3; k++) {
            f[3 * k][l] = t->rows[k][i].x;
            f[3 * k + 1][l] = t->rows[k][i].y;
            f[3 * k + 2][l] = t->rows[k][i].z;
        }
        for (int k = 0; k < 9; k++)
            sum = sb_max(sum, sb_abs(f[k][l]));
        for (int k = 0; k < 9; k++) /* in units of its largest entry, however small the elements */
            f[k][l] = sum > 0 ? f[k][l] / sum : (sb_real)(k % 4 == 0);
        for (int k = 0; k < 4; k++)
            q[k][l] = (sb_real)(k == 0);
    }
    sb_polar_batch(f, q, r);
    for (int l = 0; l < SB_POLAR_LANES && first + l < t->count; l++)
        t->rotations[first + l] = sb_quat_make(q[0][l], q[1][l], q[2][l], q[3][l]);
}

static void sbi_body_turn_task(void *user, int chunk)
{
    const sbi_body_turning *t = (const sbi_body_turning *)user;
    int last = sbi_min_int(t->count, (chunk + 1) * SBI_ROW_CHUNK);
    for (int first = chunk * SBI_ROW_CHUNK; first < last; first += SB_POLAR_LANES)
        sbi_body_turn_batch(t, first);
}

SB_API void sb_body_nodal_rotations(sb_body *body, sb_quat *rotations)
{
    sbi_body_turning turning;
    if (!body || !rotations)
        return;
    turning.rows[0] = body->work;
    turning.rows[1] = body->work2;
    turning.rows[2] = body->rhs;
    turning.rotations = rotations;
    turning.count = body->domain.node_count;
    sbi_body_sum_gradients(body, turning.rows);
    sbi_run(&body->jobs, sbi_body_turn_task, &turning, sbi_row_chunks(turning.count));
}

/* ---- what holds the parts ---- */

/* Arm of a node about the centre of its part, in units of the part's size. */
static void sbi_body_arm(const sb_body *body, int node, double arm[3])
{
    sb_vec3 low = body->component_low[body->node_component[node]];
    sb_vec3 high = body->component_high[body->node_component[node]], x = body->reference[node];
    double size = (double)sb_v3_norm(sb_v3_sub(high, low));
    arm[0] = ((double)x.x - 0.5 * ((double)low.x + (double)high.x)) / size;
    arm[1] = ((double)x.y - 0.5 * ((double)low.y + (double)high.y)) / size;
    arm[2] = ((double)x.z - 0.5 * ((double)low.z + (double)high.z)) / size;
}

/* r += weight times what the six rigid motions do to one axis of a node. */
static void sbi_body_add_motion(const sb_body *body, int node, int axis, double weight, double r[6])
{
    double arm[3];
    sbi_body_arm(body, node, arm);
    r[axis] += weight;
    r[3 + (axis + 1) % 3] += weight * arm[(axis + 2) % 3]; /* (omega x arm)_axis */
    r[3 + (axis + 2) % 3] -= weight * arm[(axis + 1) % 3];
}

/* Block (row, column) of six by six of a gram with `stride` numbers a row += r s^T. */
static void sbi_body_add_gram(double *gram, size_t stride, int row, int column, const double *r, const double *s)
{
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++)
            gram[(6 * (size_t)row + (size_t)i) * stride + 6 * (size_t)column + (size_t)j] += r[i] * s[j];
}

/* One row along one axis (of rows that are for all three). */
typedef struct sbi_body_row {
    const int *nodes, *dofs; /* one of them */
    const sb_real *weights;
    int count, axis;
    double scale;
} sbi_body_row;

static sbi_body_row sbi_body_make_row(const sbi_body_rows *rows, int index, int axis)
{
    sbi_body_row row;
    int first = rows->start[index];
    row.nodes = rows->nodes ? rows->nodes + first : NULL;
    row.dofs = rows->nodes ? NULL : rows->dofs + first;
    row.weights = rows->weights + first;
    row.count = rows->start[index + 1] - first;
    row.axis = axis;
    row.scale = 0;
    for (int k = 0; k < row.count; k++)
        row.scale += (double)sb_abs(row.weights[k]);
    return row;
}

static int sbi_body_row_part(const sb_body *body, const sbi_body_row *row, int term)
{
    return body->node_component[row->nodes ? row->nodes[term] : row->dofs[term] / 3];
}

/* What all terms of one part do to the row. */
static void sbi_body_row_motion(const sb_body *body, const sbi_body_row *row, int part, double r[6])
{
    memset(r, 0, 6 * sizeof *r);
    for (int k = 0; k < row->count; k++)
        if (sbi_body_row_part(body, row, k) == part)
            sbi_body_add_motion(body, row->nodes ? row->nodes[k] : row->dofs[k] / 3,
                                row->nodes ? row->axis : row->dofs[k] % 3, (double)row->weights[k] / row->scale, r);
}

/* 1 when the part of a term is that of no term before it: parts of a row are visited once like this. */
static int sbi_body_is_new_part(const sb_body *body, const sbi_body_row *row, int term)
{
    int part = sbi_body_row_part(body, row, term);
    for (int k = 0; k < term; k++)
        if (sbi_body_row_part(body, row, k) == part)
            return 0;
    return part >= 0;
}

/* 1 when a row goes through several parts. */
static int sbi_body_is_tie(const sb_body *body, const sbi_body_row *row)
{
    int parts = 0;
    for (int k = 0; k < row->count && parts < 2; k++)
        parts += sbi_body_is_new_part(body, row, k);
    return parts > 1;
}

/* Adds one row: its sum is held. Ties go to the gram of the tied parts. */
static void sbi_body_hold_row(const sb_body *body, const sbi_body_row *row)
{
    size_t stride = 6 * (size_t)body->tie_count;
    int tied = sbi_body_is_tie(body, row);
    for (int a = 0; a < row->count && row->scale > 0; a++)
        for (int b = 0; b < row->count && sbi_body_is_new_part(body, row, a); b++) {
            int part = sbi_body_row_part(body, row, a), other = sbi_body_row_part(body, row, b);
            double r[6], s[6];
            if ((!tied && b != a) || !sbi_body_is_new_part(body, row, b))
                continue;
            sbi_body_row_motion(body, row, part, r);
            if (tied)
                sbi_body_row_motion(body, row, other, s);
            if (tied)
                sbi_body_add_gram(body->tie_gram, stride, body->tie_of[part], body->tie_of[other], r, s);
            else
                sbi_body_add_gram(body->support_grams[part], 6, 0, 0, r, r);
        }
}

/* Gauss elimination of a gram of 6 size numbers with diagonal pivots: -1 when it has full rank, else one of the rigid
 * motions that are free. Arms are of order 1, so pivots compare with the trace of their part. */
static int sbi_body_free_motion(double *gram, int parts, double *traces)
{
    int size = 6 * parts;
    size_t n = (size_t)size;
    for (int p = 0; p < parts; p++) {
        traces[p] = 0;
        for (int i = 6 * p; i < 6 * p + 6; i++)
            traces[p] += gram[(size_t)i * (n + 1)];
    }
    for (int step = 0; step < size; step++) {
        int pivot = -1, first = -1;
        for (int i = 0; i < size; i++) {
            double d = gram[(size_t)i * (n + 1)];
            if (d < 0) /* done: marked below */
                continue;
            first = first < 0 ? i : first;
            if (d > 1e-10 * traces[i / 6] && (pivot < 0 || d > gram[(size_t)pivot * (n + 1)]))
                pivot = i;
        }
        if (pivot < 0)
            return first;
        for (int i = 0; i < size; i++) {
            double factor = gram[(size_t)i * n + (size_t)pivot] / gram[(size_t)pivot * (n + 1)];
            if (i == pivot || gram[(size_t)i * (n + 1)] < 0)
                continue;
            for (int j = 0; j < size; j++)
                if (j != pivot)
                    gram[(size_t)i * n + (size_t)j] -= factor * gram[(size_t)pivot * n + (size_t)j];
            if (gram[(size_t)i * (n + 1)] < 0) /* rounding of 0 */
                gram[(size_t)i * (n + 1)] = 0;
        }
        gram[(size_t)pivot * (n + 1)] = -1;
    }
    return -1;
}

/* Numbers the parts that rows tie to each other and that have no number yet, from `count` on; the next number. */
static int sbi_body_number_ties(sb_body *body, const sbi_body_rows *rows, int count)
{
    for (int j = 0; j < rows->count; j++) {
        sbi_body_row row = sbi_body_make_row(rows, j, 0);
        int tied = sbi_body_is_tie(body, &row);
        for (int k = 0; k < row.count && tied; k++) {
            int part = sbi_body_row_part(body, &row, k);
            if (part >= 0 && body->tie_of[part] < 0)
                body->tie_of[part] = count++;
        }
    }
    return count;
}

SBI_API sb_result sbi_body_reserve_ties(sb_body *body, const sbi_body_rows *rows, sb_error *error)
{
    int count = sbi_body_number_ties(body, rows, body->tie_count);
    if (count > body->tie_capacity) {
        size_t n = 6 * (size_t)count; /* a gram of n x n numbers and the traces */
        double *gram = (double *)sbi_alloc(&body->allocator, n + 1, n * sizeof(double));
        for (int c = 0; c < body->component_count && !gram; c++)
            body->tie_of[c] = body->tie_of[c] < body->tie_count ? body->tie_of[c] : -1;
        if (!gram)
            return sbi_fail(error, SB_ERROR_MEMORY, "no memory to tie %d parts to each other", count);
        sbi_free(&body->allocator, body->tie_gram);
        body->tie_gram = gram;
        body->tie_capacity = count;
    }
    body->tie_count = count;
    return SB_OK;
}

/* Adds the springs and the rows of a mapping, as far as they have a stiffness. */
static void sbi_body_hold_load(const sb_body *body, const sbi_load *load)
{
    sbi_body_rows rows = {load->row_count, load->row_start, load->nodes, NULL, load->weights};
    for (int j = 0; load->kind != SBI_LOAD_PRESSURE && j < load->row_count; j++)
        for (int axis = 0; axis < 3 && load->stiffness[j] > 0; axis++) {
            sbi_body_row row = sbi_body_make_row(&rows, j, axis);
            sbi_body_hold_row(body, &row);
        }
}

static void sbi_body_hold_equations(const sb_body *body, const sbi_equations *equations)
{
    sbi_body_rows rows = {equations->count, equations->start, NULL, equations->dof, equations->coefficient};
    for (int j = 0; j < rows.count; j++) {
        sbi_body_row row = sbi_body_make_row(&rows, j, 0);
        sbi_body_hold_row(body, &row);
    }
}

static void sbi_body_hold_supports(const sb_body *body)
{
    memset(body->support_grams, 0, (size_t)body->component_count * sizeof body->support_grams[0]);
    for (int i = 0; i < body->domain.node_count; i++)
        for (int axis = 0; axis < 3 && body->node_component[i] >= 0; axis++)
            if (body->fixed[i] >> axis & 1) {
                double r[6] = {0, 0, 0, 0, 0, 0};
                sbi_body_add_motion(body, i, axis, 1, r);
                sbi_body_add_gram(body->support_grams[body->node_component[i]], 6, 0, 0, r, r);
            }
}

/* 1 when supports alone hold every part: a look at thousands of rows can be spared then. Uses up the grams. */
static int sbi_body_is_held_by_supports(const sb_body *body)
{
    double trace;
    sbi_body_hold_supports(body);
    for (int c = 0; c < body->component_count; c++)
        if (sbi_body_free_motion(body->support_grams[c], 1, &trace) >= 0)
            return 0;
    return 1;
}

/* Sums what holds each part: supports, springs, mappings and constraints. */
static void sbi_body_gather_holds(const sb_body *body)
{
    size_t stride = 6 * (size_t)body->tie_count;
    sbi_body_hold_supports(body);
    if (stride)
        memset(body->tie_gram, 0, stride * stride * sizeof(double));
    for (int l = 0; l < body->load_count; l++)
        sbi_body_hold_load(body, body->loads + l);
    if (body->elimination)
        sbi_body_hold_equations(body, &body->elimination->equations);
    for (int c = 0; c < body->component_count; c++)
        for (int i = 0; i < 6 && body->tie_of[c] >= 0; i++)
            for (int j = 0; j < 6; j++)
                body->tie_gram[(6 * (size_t)body->tie_of[c] + (size_t)i) * stride + 6 * (size_t)body->tie_of[c] +
                               (size_t)j] += body->support_grams[c][6 * i + j];
}

SBI_API int sbi_body_unsupported_node(const sb_body *body)
{
    int loose = -1; /* number of a tied part that is free */
    if (sbi_body_is_held_by_supports(body))
        return -1;
    sbi_body_gather_holds(body);
    if (body->tie_count > 0) {
        size_t n = 6 * (size_t)body->tie_count;
        int motion = sbi_body_free_motion(body->tie_gram, body->tie_count, body->tie_gram + n * n);
        loose = motion < 0 ? -1 : motion / 6;
    }
    for (int c = 0; c < body->component_count; c++) {
        double trace;
        if (body->tie_of[c] >= 0 ? body->tie_of[c] != loose : sbi_body_free_motion(body->support_grams[c], 1, &trace) < 0)
            continue;
        for (int i = 0; i < body->domain.node_count; i++)
            if (body->node_component[i] == c)
                return i;
    }
    return -1;
}

/* ---- set-up check ---- */

/* 1 when an element before this one has the same corners. */
static int sbi_body_is_duplicate(const sb_body *body, int element)
{
    const sb_index_lists *lists = &body->node_elements;
    int n = body->domain.nodes_per_cell, corners = sbi_element_corner_count(sbi_domain_element(&body->domain));
    const int *cell = body->domain.cells + (size_t)element * (size_t)n;
    int local[SB_MAX_ELEMENT_NODES];
    for (int a = 0; a < corners; a++)
        local[a] = a;
    for (int k = lists->offsets[cell[0]]; lists->items[k] < element; k++)
        if (sbi_body_has_corners(cell, body->domain.cells + (size_t)lists->items[k] * (size_t)n, local, corners))
            return 1;
    return 0;
}

static void sbi_body_check_mesh(const sb_body *body, sb_check_report *report)
{
    sb_mesh mesh = sbi_body_mesh_view(body);
    report->size = sbi_body_size(body);
    report->worst_quality = 1;
    for (int e = 0; e < mesh.element_count; e++) {
        sb_real quality = sb_mesh_element_quality(&mesh, e);
        report->sliver_count += quality < (sb_real)0.1;
        report->duplicate_count += !body->own_points && sbi_body_is_duplicate(body, e);
        if (report->worst_element < 0 || quality < report->worst_quality) {
            report->worst_quality = quality;
            report->worst_element = e;
        }
    }
    for (int i = 0; i < mesh.node_count; i++)
        report->unreferenced_count += body->node_component[i] < 0;
    report->component_count = body->component_count;
    if (report->size > 10 || report->size < (sb_real)1e-3)
        report->warnings |= SB_CHECK_SIZE;
    if (report->sliver_count > 0)
        report->warnings |= SB_CHECK_SLIVERS;
    if (report->unreferenced_count > 0)
        report->warnings |= SB_CHECK_UNREFERENCED;
    if (report->duplicate_count > 0)
        report->warnings |= SB_CHECK_DUPLICATES;
    if (report->component_count > 1)
        report->warnings |= SB_CHECK_COMPONENTS;
}

/* Poisson's ratio from which the body's elements lose more than 2 % to locking; measured, see sb_check_report. */
static sb_real sbi_body_locking_limit(const sb_domain *domain)
{
    sbi_element element = sbi_domain_element(domain);
    if (domain->mean_point)
        return (sb_real)0.5;
    switch (domain->element_type) {
    case SB_TET4: return (sb_real)0.35;
    case SB_TET10: return (sb_real)0.495;
    case SB_HEX8: return (sb_real)0.4;
    case SB_CUSTOM:
        return sbi_element_node_count(element) == sbi_element_corner_count(element) ? (sb_real)0.4 : (sb_real)0.49;
    default: return (sb_real)0.49;
    }
}

static void sbi_body_check_locking(const sb_body *body, sb_check_report *report)
{
    const sb_real rounding = 1 + (sb_real)1e-5; /* of a ratio that was made of moduli */
    report->locking_limit = sbi_body_locking_limit(&body->domain);
    report->locking_element = -1;
    for (int e = 0; e < body->domain.cell_count; e++) {
        if (!(sb_material_poisson(body->materials + body->cell_material[e]) > rounding * report->locking_limit))
            continue;
        if (report->locking_count++ == 0)
            report->locking_element = e;
    }
    if (report->locking_count > 0)
        report->warnings |= SB_CHECK_LOCKING;
}

static void sbi_body_check_materials(const sb_body *body, sb_check_report *report)
{
    for (int i = 0; i < body->material_count; i++) {
        const sb_material *material = body->materials + i;
        sb_real young = sb_material_young(material);
        if (material->density < 100 || material->density > 10000)
            report->warnings |= SB_CHECK_DENSITY;
        if (young < 10 || young > (sb_real)1e7)
            report->warnings |= SB_CHECK_STIFFNESS;
    }
    sbi_body_check_locking(body, report);
}

SB_API sb_result sb_body_check(const sb_body *body, sb_check_report *report)
{
    if (!body || !report)
        return SB_ERROR_ARGUMENT;
    memset(report, 0, sizeof *report);
    report->worst_element = -1;
    sbi_body_check_mesh(body, report);
    sbi_body_check_materials(body, report);
    report->unsupported_component_node = sbi_body_unsupported_node(body);
    if (report->unsupported_component_node >= 0)
        report->warnings |= SB_CHECK_UNSUPPORTED;
    return SB_OK;
}

SB_API const char *sb_check_string(unsigned warning)
{
    switch (warning) {
    case SB_CHECK_SIZE: return "the mesh is larger than 10 m or smaller than 1 mm: is it in metres?";
    case SB_CHECK_DENSITY: return "a density is outside 100 to 10,000 kg/m^3: are the units SI?";
    case SB_CHECK_STIFFNESS: return "a Young's modulus is outside 10 Pa to 10 MPa: are the units SI?";
    case SB_CHECK_SLIVERS: return "some elements are slivers (quality under 0.1): solves will be slow";
    case SB_CHECK_LOCKING: return "Poisson's ratio is too high for this element, which locks and is too stiff: use B-bar hex8";
    case SB_CHECK_UNREFERENCED: return "some nodes belong to no element and are held in place";
    case SB_CHECK_UNSUPPORTED: return "a part is not fully supported: static solves will refuse it";
    case SB_CHECK_DUPLICATES: return "some elements are there twice: their mass and stiffness count twice";
    case SB_CHECK_COMPONENTS: return "the mesh has more than one connected part";
    default: return "unknown warning";
    }
}
