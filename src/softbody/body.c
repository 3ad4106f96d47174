/* body: creation, properties, supports, loads, readings. */
#include "body.h"
#include "body_state.h"

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
    def.tolerance = (sb_real)1e-3;
    def.max_iterations = 500;
    def.max_newton = SB_AUTO;
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
    if (def->integrator != SB_EULER && def->integrator != SB_NEWMARK)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.integrator %d is unknown", (int)def->integrator);
    if (def->integration < SB_INTEGRATION_AUTO || def->integration > SB_INTEGRATION_CURVED)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.integration %d is unknown", (int)def->integration);
    if (def->mass != SB_MASS_LUMPED && def->mass != SB_MASS_CONSISTENT && def->mass != SB_MASS_REDUCED)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.mass %d is unknown", (int)def->mass);
    if (def->allocator.alloc && !def->allocator.release)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.allocator has alloc but no release");
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
        sb_result result = sbi_body_check_material(material, def->single_rotation, error);
        if (result != SB_OK)
            return result;
        body->materials[i] = *material;
    }
    return SB_OK;
}

/* ---- creation: memory ---- */

/* Lays out every array of the body; walked once to measure and once to hand out. */
static void sbi_body_layout(sb_body *body, sbi_arena *arena)
{
    size_t n = (size_t)body->domain.node_count;
    sb_vec3 **vectors[] = {&body->reference, &body->position,     &body->displacement,  &body->velocity,
                           &body->target,    &body->dead_load,    &body->acceleration,  &body->internal,
                           &body->external,  &body->equilibrated, &body->residual,      &body->rhs,
                           &body->increment, &body->reaction,     &body->velocity0,     &body->acceleration0,
                           &body->start,     &body->saved_velocity, &body->saved_acceleration,
                           &body->saved_reaction, &body->saved_external, &body->saved_internal, &body->converged,
                           &body->work,      &body->work2};
    for (size_t i = 0; i < sizeof vectors / sizeof vectors[0]; i++)
        *vectors[i] = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    body->lumped_mass = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    body->load_mass = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    if (body->mass_kind != SB_MASS_LUMPED)
        body->mass_blocks = (sb_real *)sbi_arena_take(arena, (size_t)body->matrix.block_count, sizeof(sb_real));
    body->fixed = (unsigned char *)sbi_arena_take(arena, n, 1);
    body->support_grams = (double(*)[36])sbi_arena_take(arena, (size_t)body->component_count, 36 * sizeof(double));
    body->component_low = (sb_vec3 *)sbi_arena_take(arena, (size_t)body->component_count, sizeof(sb_vec3));
    body->component_high = (sb_vec3 *)sbi_arena_take(arena, (size_t)body->component_count, sizeof(sb_vec3));
    body->node_component = (int *)sbi_arena_take(arena, n, sizeof(int));
    sbi_assembly_layout(&body->assembly, &body->domain, body->matrix.block_count, arena);
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
static void sbi_body_add_mass_blocks(sb_body *body, int element, const sb_real *mass, sb_real density)
{
    int n = body->domain.nodes_per_cell;
    const int *at = body->assembly.scatter + (size_t)element * (size_t)(n * (n + 1) / 2);
    for (int a = 0; a < n; a++)
        for (int b = a; b < n; b++, at++) {
            body->mass_blocks[*at] += density * mass[a * n + b];
            if (a != b)
                body->mass_blocks[body->matrix.transpose[*at]] += density * mass[a * n + b];
        }
}

SBI_API void sbi_body_update_mass(sb_body *body)
{
    sb_real mass[SB_MAX_ELEMENT_NODES * SB_MAX_ELEMENT_NODES], load[SB_MAX_ELEMENT_NODES];
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    int n = body->domain.nodes_per_cell;
    memset(body->lumped_mass, 0, (size_t)body->domain.node_count * sizeof(sb_real));
    memset(body->load_mass, 0, (size_t)body->domain.node_count * sizeof(sb_real));
    if (body->mass_blocks)
        memset(body->mass_blocks, 0, (size_t)body->matrix.block_count * sizeof(sb_real));
    for (int e = 0; e < body->domain.cell_count; e++) {
        const int *cell = body->domain.cells + (size_t)e * (size_t)n;
        sb_real density = body->materials[body->cell_material[e]].density;
        sbi_body_gather_reference(body, e, x);
        if (body->mass_blocks) {
            sbi_element_mass(body->domain.element_type, body->mass_kind, x, mass, load);
            sbi_body_add_mass_blocks(body, e, mass, density);
        }
        sbi_element_mass(body->domain.element_type, SB_MASS_LUMPED, x, mass, load);
        for (int a = 0; a < n; a++) {
            body->lumped_mass[cell[a]] += density * mass[a * n + a];
            body->load_mass[cell[a]] += density * load[a];
        }
    }
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
        for (int k = matrix->row_start[i]; k < matrix->row_start[i + 1]; k++)
            sum = sb_v3_madd(sum, body->mass_blocks[k], x[matrix->columns[k]]);
        out[i] = sum;
    }
}

SBI_API void sbi_body_add_mass(sb_body *body, sb_real factor)
{
    sb_matrix *matrix = &body->matrix;
    for (int i = 0; i < matrix->row_count; i++) {
        int first = body->mass_blocks ? matrix->row_start[i] : matrix->diagonal[i];
        int end = body->mass_blocks ? matrix->row_start[i + 1] : first + 1;
        for (int k = first; k < end; k++) {
            sb_real m = factor * (body->mass_blocks ? body->mass_blocks[k] : body->lumped_mass[i]);
            matrix->blocks[k][0] += m;
            matrix->blocks[k][4] += m;
            matrix->blocks[k][8] += m;
        }
    }
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
    if (!needed || body->damping_blocks)
        return SB_OK;
    body->damping_blocks =
        (sb_real(*)[9])sbi_alloc(&body->allocator, (size_t)body->matrix.block_count + 1, 9 * sizeof(sb_real));
    if (!body->damping_blocks)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the damping of %d blocks", body->matrix.block_count);
    return SB_OK;
}

static sb_result sbi_body_make_preconditioner(sb_body *body, const sb_body_def *def, sb_error *error)
{
    sb_preconditioner_def settings = sb_default_preconditioner_def();
    settings.kind = def->preconditioner;
    settings.positions = def->mesh->nodes;
    return sb_preconditioner_create(&settings, &body->matrix, &body->allocator, &body->precond, error);
}

static sb_result sbi_body_build(sb_body *body, const sb_body_def *def, sb_error *error)
{
    const sb_allocator *allocator = &body->allocator;
    uint64_t *node_colours;
    sb_result result = sb_domain_create(def->mesh, def->integration, def->single_rotation, allocator,
                                        &body->domain, error);
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
    sb_pcg_workspace_free(&body->pcg);
    sb_preconditioner_free(body->precond);
    sb_matrix_free(&body->matrix);
    sb_index_table_free(&body->element_component);
    sb_index_lists_free(&body->node_elements);
    sb_domain_free(&body->domain);
    sbi_free(&allocator, body->support_blocks);
    sbi_free(&allocator, body->damping_blocks);
    sbi_free(&allocator, body->cell_material);
    sbi_free(&allocator, body->materials);
    sbi_free(&allocator, body->material_regions);
    sbi_free(&allocator, body->memory);
    sbi_free(&allocator, body);
}

/* ---- sizes ---- */

SB_API int sb_body_node_count(const sb_body *body) { return body->domain.node_count; }
SB_API int sb_body_element_count(const sb_body *body) { return body->domain.cell_count; }
SB_API int sb_body_point_count(const sb_body *body) { return body->domain.points_per_cell; }
SB_API int sb_body_matrix_blocks(const sb_body *body) { return body->matrix.block_count; }

/* ---- properties ---- */

SB_API sb_result sb_body_set_material(sb_body *body, const sb_material *material, sb_error *error)
{
    sb_result result;
    if (!body || !material)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_set_material needs a body and a material");
    result = sbi_body_check_material(material, body->domain.single_rotation, error);
    if (result == SB_OK)
        result = sbi_body_reserve_damping(body, material, 1, error);
    if (result != SB_OK)
        return result;
    for (int i = 0; i < body->material_count; i++)
        body->materials[i] = *material;
    sbi_body_materials_changed(body);
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
        result = sbi_body_reserve_damping(body, material, 1, error);
    if (result != SB_OK)
        return result;
    body->materials[at] = *material;
    sbi_body_materials_changed(body);
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

/* ---- supports ---- */

static sb_result sbi_body_check_nodes(const sb_body *body, const int *nodes, int count)
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
    return body->matrix.row_start[node + 1] - body->matrix.row_start[node];
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
    result = sbi_body_reserve_supports(body, nodes, count);
    for (int i = 0; i < count && result == SB_OK; i++) {
        int node = nodes[i];
        if (!body->fixed[node])
            body->support_used += sbi_body_row_length(body, node);
        body->fixed[node] |= (unsigned char)axes;
        body->target[node] = sbi_body_pick_axes((unsigned)axes, targets ? targets[i * stride] : body->displacement[node],
                                                body->target[node]);
    }
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

SB_API const unsigned char *sb_body_supports(const sb_body *body) { return body->fixed; }

/* ---- loads ---- */

SB_API sb_result sb_body_add_forces(sb_body *body, const int *nodes, int count, const sb_vec3 *forces, int uniform)
{
    sb_result result = sbi_body_check_nodes(body, nodes, count);
    if (result != SB_OK)
        return result;
    if (count > 0 && !forces)
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < (uniform ? sbi_min_int(count, 1) : count); i++)
        if (!sb_v3_is_finite(forces[i]))
            return SB_ERROR_NOT_FINITE;
    for (int i = 0; i < count; i++)
        body->dead_load[nodes[i]] = sb_v3_add(body->dead_load[nodes[i]], forces[uniform ? 0 : i]);
    if (count > 0)
        sbi_body_tell(body, SBI_COMMAND_FORCES, 0, uniform != 0, nodes, (size_t)count, &forces[0].x,
                      uniform ? 3 : 3 * (size_t)count);
    return SB_OK;
}

SB_API void sb_body_clear_loads(sb_body *body)
{
    memset(body->dead_load, 0, (size_t)body->domain.node_count * sizeof(sb_vec3));
    sbi_body_tell(body, SBI_COMMAND_CLEAR_LOADS, 0, 0, NULL, 0, NULL, 0);
}

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

/* Finds the element face with these corner nodes: its global nodes, count and type; 0 when there is none. */
static int sbi_body_find_face(const sb_body *body, const int *corners, int count, int *nodes,
                              sb_element_type *face_type)
{
    const sb_index_lists *lists = &body->node_elements;
    sb_element_type type = body->domain.element_type;
    int n = body->domain.nodes_per_cell;
    for (int k = lists->offsets[corners[0]]; k < lists->offsets[corners[0] + 1]; k++) {
        const int *cell = body->domain.cells + (size_t)lists->items[k] * (size_t)n;
        for (int face = 0; face < sb_element_face_count(type); face++) {
            int local[SB_MAX_FACE_NODES], face_nodes = sb_element_face(type, face, local, face_type);
            if (sb_element_corner_count(*face_type) != count ||
                !sbi_body_has_corners(corners, cell, local, count))
                continue;
            for (int i = 0; i < face_nodes; i++)
                nodes[i] = cell[local[i]];
            return face_nodes;
        }
    }
    return 0;
}

/* load_a += int t N_a dA over a face of the reference shape. */
static void sbi_body_add_face_load(sb_body *body, const int *nodes, int count, sb_element_type face_type,
                                   sb_vec3 traction)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    int q = sb_element_quadrature(face_type, SB_QUADRATURE_FACE, points, weights);
    for (int p = 0; p < q; p++) {
        sb_real shape[SB_MAX_ELEMENT_NODES], gradient[SB_MAX_ELEMENT_NODES][3], area;
        sb_vec3 r = sb_v3(0, 0, 0), s = r;
        sb_element_shape(face_type, points[p], shape, gradient);
        for (int a = 0; a < count; a++) {
            r = sb_v3_madd(r, gradient[a][0], body->reference[nodes[a]]);
            s = sb_v3_madd(s, gradient[a][1], body->reference[nodes[a]]);
        }
        area = weights[p] * sb_v3_norm(sb_v3_cross(r, s));
        for (int a = 0; a < count; a++)
            body->dead_load[nodes[a]] = sb_v3_madd(body->dead_load[nodes[a]], area * shape[a], traction);
    }
}

SB_API sb_result sb_body_add_traction(sb_body *body, const int *faces, int face_count, int corners,
                                      sb_vec3 traction, sb_error *error)
{
    int nodes[SB_MAX_FACE_NODES];
    sb_element_type face_type;
    if (!body || face_count < 0 || corners < 3 || corners > 4 || (face_count > 0 && !faces))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_add_traction needs faces of 3 or 4 corners");
    if (!sb_v3_is_finite(traction))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the traction is not finite");
    for (int pass = 0; pass < 2; pass++) /* find all faces before any load changes */
        for (int f = 0; f < face_count; f++) {
            const int *face = faces + (size_t)f * (size_t)corners;
            int count;
            if (pass == 0 && sbi_body_check_nodes(body, face, corners) != SB_OK)
                return sbi_fail(error, SB_ERROR_INDEX, "face %d has a node index outside the mesh", f);
            count = sbi_body_find_face(body, face, corners, nodes, &face_type);
            if (count == 0)
                return sbi_fail_node(error, SB_ERROR_ARGUMENT, face[0],
                                     "face %d (nodes %d %d %d ...) is no face of an element", f, face[0], face[1],
                                     face[2]);
            if (pass == 1)
                sbi_body_add_face_load(body, nodes, count, face_type, traction);
        }
    sbi_body_tell(body, SBI_COMMAND_TRACTION, corners, 0, faces, (size_t)face_count * (size_t)corners, &traction.x, 3);
    return SB_OK;
}

/* ---- state ---- */

SB_API const sb_vec3 *sb_body_positions(const sb_body *body) { return body->position; }
SB_API const sb_vec3 *sb_body_displacements(const sb_body *body) { return body->displacement; }
SB_API const sb_vec3 *sb_body_velocities(const sb_body *body) { return body->velocity; }
SB_API const sb_vec3 *sb_body_reactions(const sb_body *body) { return body->reaction; }
SB_API const sb_vec3 *sb_body_external_forces(const sb_body *body) { return body->external; }

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

SB_API void sb_body_reset(sb_body *body)
{
    size_t bytes = (size_t)body->domain.node_count * sizeof(sb_vec3);
    memset(body->displacement, 0, bytes);
    memset(body->velocity, 0, bytes);
    memset(body->acceleration, 0, bytes);
    memset(body->reaction, 0, bytes);
    memset(body->external, 0, bytes);
    memset(body->equilibrated, 0, bytes);
    sbi_assembly_reset_rotations(&body->assembly);
    sbi_body_update_positions(body);
    body->force_current = 0;
    body->acceleration_known = 0;
    sbi_body_tell(body, SBI_COMMAND_RESET, 0, 0, NULL, 0, NULL, 0);
}

/* ---- readings ---- */

SB_API sb_result sb_body_energy(sb_body *body, sb_energy *energy)
{
    sb_energy sum = {0, 0};
    if (!body || !energy)
        return SB_ERROR_ARGUMENT;
    if (sbi_assembly_energy(&body->assembly, body->displacement, &sum.elastic) >= 0)
        return SB_ERROR_INVERTED;
    sbi_body_mass_multiply(body, body->velocity, body->work);
    for (int i = 0; i < body->domain.node_count; i++)
        sum.kinetic += (sb_real)0.5 * sb_v3_dot(body->velocity[i], body->work[i]);
    if (!sb_is_finite(sum.elastic) || !sb_is_finite(sum.kinetic))
        return SB_ERROR_NOT_FINITE;
    *energy = sum;
    return SB_OK;
}

SB_API sb_real sb_body_mass(const sb_body *body)
{
    sb_real sum = 0;
    for (int i = 0; i < body->domain.node_count; i++)
        sum += body->lumped_mass[i];
    return sum;
}

SB_API sb_vec3 sb_body_momentum(const sb_body *body)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int i = 0; i < body->domain.node_count; i++)
        sum = sb_v3_madd(sum, body->mass_blocks ? body->load_mass[i] : body->lumped_mass[i], body->velocity[i]);
    return sum;
}

/* Cauchy stresses at the points of an element; 0, and admissible[point] 0, where there is none. */
static void sbi_body_element_stresses(const sb_body *body, int element, sb_mat3 *stress, int *admissible)
{
    const sb_material *material = body->materials + body->cell_material[element];
    sb_mat3 f[SB_MAX_QUADRATURE_POINTS], p[SB_MAX_QUADRATURE_POINTS];
    sbi_assembly_points(&body->assembly, body->displacement, element, f, p, admissible);
    for (int i = 0; i < body->domain.points_per_cell; i++) {
        if (material->model != SB_LINEAR && sb_m3_det(f[i]) == 0)
            admissible[i] = 0;
        if (admissible[i])
            stress[i] = sb_material_cauchy_stress(material, f[i], p[i]);
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
    if (element < 0 || element >= body->domain.cell_count || point < 0 || point >= body->domain.points_per_cell)
        return SB_ERROR_INDEX;
    sbi_body_element_stresses(body, element, all, admissible);
    if (!admissible[point])
        return SB_ERROR_INVERTED;
    *stress = all[point];
    return SB_OK;
}

static sb_real sbi_body_element_von_mises(const sb_body *body, int element)
{
    sb_mat3 stress[SB_MAX_QUADRATURE_POINTS];
    int admissible[SB_MAX_QUADRATURE_POINTS];
    sb_real sum = 0;
    sbi_body_element_stresses(body, element, stress, admissible);
    for (int p = 0; p < body->domain.points_per_cell; p++)
        sum += sb_von_mises(stress[p]);
    return sum / (sb_real)body->domain.points_per_cell;
}

SB_API void sb_body_von_mises(const sb_body *body, sb_real *values)
{
    for (int e = 0; e < body->domain.cell_count; e++)
        values[e] = sbi_body_element_von_mises(body, e);
}

static sb_real sbi_body_element_volume(const sb_body *body, int element)
{
    sb_real sum = 0;
    int q = body->domain.points_per_cell;
    for (int p = 0; p < q; p++)
        sum += body->domain.weights[(size_t)element * (size_t)q + (size_t)p];
    return sum;
}

SB_API void sb_body_nodal_von_mises(const sb_body *body, sb_real *values)
{
    const sb_domain *domain = &body->domain;
    const sb_index_lists *lists = &body->node_elements;
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

/* ---- set-up check ---- */

/* Adds row r r^T of one supported axis: r is what the six rigid motions do to it. */
static void sbi_body_add_support(double *gram, const double *arm, int axis)
{
    double r[6] = {0, 0, 0, 0, 0, 0};
    r[axis] = 1;
    r[3 + (axis + 1) % 3] = arm[(axis + 2) % 3]; /* (omega x arm)_axis */
    r[3 + (axis + 2) % 3] = -arm[(axis + 1) % 3];
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++)
            gram[6 * i + j] += r[i] * r[j];
}

/* Rank 6 by Gauss elimination with diagonal pivots; arms are of order 1, so pivots compare with the trace. */
static int sbi_body_has_full_rank(double *gram)
{
    double trace = 0;
    unsigned done = 0;
    for (int i = 0; i < 6; i++)
        trace += gram[7 * i];
    for (int step = 0; step < 6; step++) {
        int pivot = -1;
        for (int i = 0; i < 6; i++)
            if (!(done >> i & 1) && (pivot < 0 || gram[7 * i] > gram[7 * pivot]))
                pivot = i;
        if (!(gram[7 * pivot] > 1e-10 * trace))
            return 0;
        done |= 1u << pivot;
        for (int i = 0; i < 6; i++)
            for (int j = 0; j < 6 && !(done >> i & 1); j++)
                if (!(done >> j & 1))
                    gram[6 * i + j] -= gram[6 * i + pivot] * gram[6 * j + pivot] / gram[7 * pivot];
    }
    return 1;
}

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

SBI_API int sbi_body_unsupported_node(const sb_body *body)
{
    memset(body->support_grams, 0, (size_t)body->component_count * sizeof body->support_grams[0]);
    for (int i = 0; i < body->domain.node_count; i++) {
        double arm[3];
        if (!body->fixed[i] || body->node_component[i] < 0)
            continue;
        sbi_body_arm(body, i, arm);
        for (int axis = 0; axis < 3; axis++)
            if (body->fixed[i] >> axis & 1)
                sbi_body_add_support(body->support_grams[body->node_component[i]], arm, axis);
    }
    for (int c = 0; c < body->component_count; c++)
        if (!sbi_body_has_full_rank(body->support_grams[c]))
            for (int i = 0; i < body->domain.node_count; i++)
                if (body->node_component[i] == c)
                    return i;
    return -1;
}

/* 1 when an element before this one has the same corners. */
static int sbi_body_is_duplicate(const sb_body *body, int element)
{
    const sb_index_lists *lists = &body->node_elements;
    int n = body->domain.nodes_per_cell, corners = sb_element_corner_count(body->domain.element_type);
    const int *cell = body->domain.cells + (size_t)element * (size_t)n;
    static const int local[8] = {0, 1, 2, 3, 4, 5, 6, 7};
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
        report->duplicate_count += sbi_body_is_duplicate(body, e);
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

static void sbi_body_check_materials(const sb_body *body, sb_check_report *report)
{
    int locks = body->domain.element_type == SB_TET4 || body->domain.element_type == SB_HEX8;
    for (int i = 0; i < body->material_count; i++) {
        const sb_material *material = body->materials + i;
        sb_real young = sb_material_young(material);
        if (material->density < 100 || material->density > 10000)
            report->warnings |= SB_CHECK_DENSITY;
        if (young < 10 || young > (sb_real)1e7)
            report->warnings |= SB_CHECK_STIFFNESS;
        if (locks && sb_material_poisson(material) > (sb_real)0.49)
            report->warnings |= SB_CHECK_LOCKING;
    }
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
    case SB_CHECK_LOCKING: return "Poisson's ratio above 0.49 locks tet4 and hex8: use tet10";
    case SB_CHECK_UNREFERENCED: return "some nodes belong to no element and are held in place";
    case SB_CHECK_UNSUPPORTED: return "a part is not fully supported: static solves will refuse it";
    case SB_CHECK_DUPLICATES: return "some elements are there twice: their mass and stiffness count twice";
    case SB_CHECK_COMPONENTS: return "the mesh has more than one connected part";
    default: return "unknown warning";
    }
}
