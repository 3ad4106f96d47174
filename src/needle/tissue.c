/* tissue: creation, supports, loads and readings. */
#include "tissue_private.h"

#include "image.h"

#include <string.h>

enum { NDLI_TISSUE_COOKIE = 0x7155 };

NDL_API ndl_tissue_def ndl_default_tissue_def(void)
{
    ndl_tissue_def def;
    memset(&def, 0, sizeof def);
    def.integrator = NDL_NEWMARK;
    def.damping_stiffness = (sb_real)0.005;
    def.slack = (sb_real)0.2;
    def.lazy_angle = (sb_real)0.01;
    def.tolerance = (sb_real)1e-4;
    def.max_iterations = 200;
    def.cookie = NDLI_TISSUE_COOKIE;
    return def;
}

/* ---- creation ---- */

static sb_result ndli_solid_check_elastic(sb_real young, sb_real poisson, int region, sb_error *error)
{
    if (!(young > 0) || !sb_is_finite(young))
        return sbi_fail(error, SB_ERROR_MATERIAL, "region %d: young must be positive and finite, not %g", region,
                        (double)young);
    if (!(poisson > -1) || !(poisson < (sb_real)0.5))
        return sbi_fail(error, SB_ERROR_MATERIAL, "region %d: poisson must be in (-1, 0.5), not %g", region,
                        (double)poisson);
    return SB_OK;
}

static sb_result ndli_solid_check_numbers(const ndl_tissue_def *def, sb_error *error)
{
    if (def->integrator != NDL_NEWMARK && def->integrator != NDL_EULER)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "integrator %d is unknown", (int)def->integrator);
    if (!(def->damping_mass >= 0) || !sb_is_finite(def->damping_mass) || !(def->damping_stiffness >= 0) ||
        !sb_is_finite(def->damping_stiffness))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "damping_mass and damping_stiffness must be >= 0 and finite");
    if (!sb_v3_is_finite(def->gravity))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "gravity is not finite");
    if (!(def->lazy_angle >= 0) || !(def->lazy_angle <= 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "lazy_angle is not in [0, 1]");
    if (!(def->tolerance > 0) || !(def->tolerance < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "tolerance is not in (0, 1)");
    if (def->max_iterations < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_iterations must be at least 1, not %d", def->max_iterations);
    return SB_OK;
}

static sb_result ndli_solid_check_def(const ndl_tissue_def *def, sb_error *error)
{
    sb_result result;
    if (!def || def->cookie != NDLI_TISSUE_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by ndl_default_tissue_def");
    if (!def->mesh || !def->materials || def->material_count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a tissue needs a mesh and materials");
    if (def->fixed_count < 0 || (def->fixed_count > 0 && !def->fixed_nodes))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "fixed_nodes is NULL or fixed_count negative");
    result = ndli_solid_check_numbers(def, error);
    for (int i = 0; result == SB_OK && i < def->material_count; i++) {
        const ndl_tissue_material *m = def->materials + i;
        result = ndli_solid_check_elastic(m->young, m->poisson, i, error);
        if (result == SB_OK && (!(m->density > 0) || !sb_is_finite(m->density)))
            result = sbi_fail(error, SB_ERROR_MATERIAL, "region %d: density must be positive and finite", i);
    }
    for (int i = 0; result == SB_OK && i < def->fixed_count; i++)
        if (def->fixed_nodes[i] < 0 || def->fixed_nodes[i] >= def->mesh->node_count)
            result = sbi_fail_node(error, SB_ERROR_INDEX, def->fixed_nodes[i], "fixed node %d does not exist",
                                   def->fixed_nodes[i]);
    return result;
}

static void ndli_solid_set_lame(sb_real *lame, sb_real young, sb_real poisson)
{
    lame[0] = young * poisson / ((1 + poisson) * (1 - 2 * poisson));
    lame[1] = young / (2 * (1 + poisson));
}

static void ndli_solid_configure(ndl_tissue *t, const ndl_tissue_def *def)
{
    t->jobs = def->jobs;
    t->clock = def->clock;
    t->integrator = def->integrator;
    t->damping_mass = def->damping_mass;
    t->damping_stiffness = def->damping_stiffness;
    t->gravity = def->gravity;
    t->lazy_angle = def->lazy_angle;
    t->tolerance = def->tolerance;
    t->max_iterations = def->max_iterations;
}

/* The mesh with the densities, and Lame's constants. */
static sb_result ndli_solid_make_mesh(ndl_tissue *t, const ndl_tissue_def *def, sb_error *error)
{
    size_t count = (size_t)def->material_count;
    sb_real *densities = (sb_real *)sbi_alloc(&t->allocator, count, sizeof(sb_real));
    sb_result result = SB_ERROR_MEMORY;
    t->lame = (sb_real *)sbi_alloc(&t->allocator, count, 2 * sizeof(sb_real));
    if (densities && t->lame) {
        for (size_t i = 0; i < count; i++) {
            densities[i] = def->materials[i].density;
            ndli_solid_set_lame(t->lame + 2 * i, def->materials[i].young, def->materials[i].poisson);
        }
        t->material_count = def->material_count;
        result = ndl_tissue_mesh_create(def->mesh, densities, def->material_count, def->slack, &t->allocator, &t->mesh,
                                        error);
    } else {
        sbi_fail(error, result, "out of memory for %d materials", def->material_count);
    }
    sbi_free(&t->allocator, densities);
    return result;
}

/* A saved state belongs to tissues with the same of all this. */
static void ndli_solid_set_make(ndl_tissue *t)
{
    const ndl_tissue_mesh *mesh = &t->mesh;
    size_t nodes = (size_t)mesh->node_end, tets = (size_t)mesh->tet_end;
    uint64_t hash = ndli_image_hash(nodes, mesh->X, nodes * sizeof(sb_vec3));
    hash = ndli_image_hash(hash, mesh->tets, tets * 4 * sizeof(int));
    hash = ndli_image_hash(hash, mesh->regions, tets * sizeof(int));
    hash = ndli_image_hash(hash, mesh->densities, (size_t)mesh->density_count * sizeof(sb_real));
    hash = sbi_hash_word(hash, sbi_real_bits(t->lazy_angle));
    hash = sbi_hash_word(hash, sbi_real_bits(t->tolerance));
    hash = sbi_hash_word(hash, (uint64_t)t->max_iterations);
    t->make = sbi_hash_word(hash, (uint64_t)t->integrator);
}

NDL_API sb_result ndl_tissue_create(const ndl_tissue_def *def, ndl_tissue **tissue, sb_error *error)
{
    ndl_tissue *t;
    sb_result result;
    if (!tissue)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "tissue is NULL");
    result = ndli_solid_check_def(def, error);
    if (result != SB_OK)
        return result;
    t = (ndl_tissue *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *t);
    if (!t)
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for a tissue");
    t->allocator = def->allocator;
    ndli_solid_configure(t, def);
    result = ndli_solid_make_mesh(t, def, error);
    if (result == SB_OK && (!ndli_solid_rebuild(t) || !ndli_solid_coarse_create(t)))
        result = sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the matrix of a tissue of %d nodes",
                          def->mesh->node_count);
    if (result != SB_OK) {
        ndl_tissue_destroy(t);
        return result;
    }
    ndli_solid_set_make(t);
    for (int i = 0; i < def->fixed_count; i++)
        ndl_tissue_fix(t, def->fixed_nodes[i]);
    t->mesh.listener = ndli_solid_changed;
    t->mesh.listener_user = t;
    *tissue = t;
    return SB_OK;
}

NDL_API void ndl_tissue_destroy(ndl_tissue *tissue)
{
    sb_allocator allocator;
    if (!tissue)
        return;
    allocator = tissue->allocator;
    ndli_solid_free(tissue);
    sbi_free(&allocator, tissue->lame);
    ndl_tissue_mesh_free(&tissue->mesh);
    sbi_free(&allocator, tissue);
}

NDL_API ndl_tissue_mesh *ndl_tissue_get_mesh(ndl_tissue *tissue) { return tissue ? &tissue->mesh : NULL; }

/* ---- supports and loads ---- */

/* A slot in use for which there is memory. */
static int ndli_solid_knows(const ndl_tissue *t, int node)
{
    return t && ndli_solid_is_node(t, node) && node < t->node_room;
}

NDLI_API void ndli_solid_set_role(ndl_tissue *t, int node, int role)
{
    if (t->role[node] == role)
        return;
    if (t->role[node] == NDLI_ROW_HELD || role == NDLI_ROW_HELD)
        t->coarse.age = 0; /* the rows of a coupled node may stay in the coarse matrix for a while */
    t->role[node] = (unsigned char)role;
    t->node_dirty[node] = 1;
}

static void ndli_solid_hold(ndl_tissue *t, int node, sb_vec3 position)
{
    ndli_solid_set_role(t, node, NDLI_ROW_HELD);
    t->target[node] = position;
    t->has_velocity[node] = 0;
    t->mesh.node_flags[node] |= NDL_NODE_FIXED;
}

NDL_API sb_result ndl_tissue_fix(ndl_tissue *tissue, int node)
{
    if (!ndli_solid_knows(tissue, node))
        return tissue ? SB_ERROR_INDEX : SB_ERROR_ARGUMENT;
    ndli_solid_hold(tissue, node, tissue->mesh.x[node]);
    return SB_OK;
}

NDL_API sb_result ndl_tissue_prescribe(ndl_tissue *tissue, int node, sb_vec3 position, const sb_vec3 *velocity)
{
    if (!ndli_solid_knows(tissue, node))
        return tissue ? SB_ERROR_INDEX : SB_ERROR_ARGUMENT;
    if (!sb_v3_is_finite(position) || (velocity && !sb_v3_is_finite(*velocity)))
        return SB_ERROR_NOT_FINITE;
    ndli_solid_hold(tissue, node, position);
    if (velocity) {
        tissue->target_velocity[node] = *velocity;
        tissue->has_velocity[node] = 1;
    }
    return SB_OK;
}

NDL_API sb_result ndl_tissue_release(ndl_tissue *tissue, int node)
{
    if (!ndli_solid_knows(tissue, node))
        return tissue ? SB_ERROR_INDEX : SB_ERROR_ARGUMENT;
    if (tissue->role[node] == NDLI_ROW_HELD) {
        ndli_solid_set_role(tissue, node, NDLI_ROW_FREE);
        tissue->mesh.node_flags[node] = (unsigned char)(tissue->mesh.node_flags[node] & ~NDL_NODE_FIXED);
    }
    return SB_OK;
}

NDL_API int ndl_tissue_is_held(const ndl_tissue *tissue, int node)
{
    return ndli_solid_knows(tissue, node) && tissue->role[node] == NDLI_ROW_HELD;
}

NDL_API sb_result ndl_tissue_set_force(ndl_tissue *tissue, int node, sb_vec3 force)
{
    if (!ndli_solid_knows(tissue, node))
        return tissue ? SB_ERROR_INDEX : SB_ERROR_ARGUMENT;
    if (!sb_v3_is_finite(force))
        return SB_ERROR_NOT_FINITE;
    tissue->force[node] = force;
    return SB_OK;
}

NDL_API sb_result ndl_tissue_set_gravity(ndl_tissue *tissue, sb_vec3 gravity)
{
    if (!tissue)
        return SB_ERROR_ARGUMENT;
    if (!sb_v3_is_finite(gravity))
        return SB_ERROR_NOT_FINITE;
    tissue->gravity = gravity;
    return SB_OK;
}

NDL_API sb_result ndl_tissue_set_damping(ndl_tissue *tissue, sb_real alpha, sb_real beta)
{
    if (!tissue || !(alpha >= 0) || !(beta >= 0))
        return SB_ERROR_ARGUMENT;
    if (!sb_is_finite(alpha) || !sb_is_finite(beta))
        return SB_ERROR_NOT_FINITE;
    tissue->damping_mass = alpha;
    tissue->damping_stiffness = beta;
    return SB_OK;
}

NDL_API sb_result ndl_tissue_set_material(ndl_tissue *tissue, int region, sb_real young, sb_real poisson,
                                          sb_error *error)
{
    sb_result result;
    if (!tissue)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "tissue is NULL");
    if (region < 0 || region >= tissue->material_count)
        return sbi_fail(error, SB_ERROR_INDEX, "region %d has no material", region);
    result = ndli_solid_check_elastic(young, poisson, region, error);
    if (result != SB_OK)
        return result;
    ndli_solid_set_lame(tissue->lame + 2 * (size_t)region, young, poisson);
    for (int e = 0; !tissue->broken && e < tissue->mesh.tet_end; e++)
        if (tissue->mesh.tets[4 * (size_t)e] >= 0)
            ndli_solid_measure(tissue, e);
    tissue->changed = 1;
    tissue->coarse.age = 0;
    return SB_OK;
}

/* ---- readings ---- */

NDL_API const sb_vec3 *ndl_tissue_positions(const ndl_tissue *tissue) { return tissue ? tissue->mesh.x : NULL; }
NDL_API sb_result ndl_tissue_original_positions(const ndl_tissue *tissue, sb_vec3 *positions)
{
    const ndl_tissue_mesh *mesh;
    if (!tissue || !positions)
        return SB_ERROR_ARGUMENT;
    mesh = &tissue->mesh;
    memcpy(positions, mesh->x, (size_t)mesh->original_nodes * sizeof(sb_vec3));
    for (int i = 0; i < mesh->displaced_count; i++) {
        int node = mesh->displaced[i];
        sb_real w[4];
        const int *n = mesh->tets + 4 * (size_t)ndli_tissue_source(mesh, mesh->X0[node], mesh->node_star[node] / 4, w);
        positions[node] = sb_v3(0, 0, 0);
        for (int c = 0; c < 4; c++)
            positions[node] = sb_v3_madd(positions[node], w[c], mesh->x[n[c]]);
    }
    return SB_OK;
}

NDL_API const sb_vec3 *ndl_tissue_velocities(const ndl_tissue *tissue) { return tissue ? tissue->mesh.v : NULL; }
NDL_API const sb_vec3 *ndl_tissue_reactions(const ndl_tissue *tissue) { return tissue ? tissue->reaction : NULL; }

/* V (mu |F - R|^2 + lambda/2 (tr(R^T F) - 3)^2) of a tet. */
static sb_real ndli_solid_energy(const ndl_tissue *t, int tet)
{
    const ndl_tissue_mesh *mesh = &t->mesh;
    const int *n = mesh->tets + 4 * (size_t)tet;
    const sb_real *lame = t->lame + 2 * (size_t)(t->material_count == 1 ? 0 : mesh->regions[tet]);
    sb_mat3 shape, now, f, r, gap;
    sb_real trace;
    shape = sb_m3_columns(sb_v3_sub(mesh->X[n[1]], mesh->X[n[0]]), sb_v3_sub(mesh->X[n[2]], mesh->X[n[0]]),
                          sb_v3_sub(mesh->X[n[3]], mesh->X[n[0]]));
    now = sb_m3_columns(sb_v3_sub(mesh->x[n[1]], mesh->x[n[0]]), sb_v3_sub(mesh->x[n[2]], mesh->x[n[0]]),
                        sb_v3_sub(mesh->x[n[3]], mesh->x[n[0]]));
    f = sb_m3_mul(now, sb_m3_inverse(shape));
    r = sb_quat_to_mat3(sb_m3_polar_cold(f));
    gap = sb_m3_sub(f, r);
    trace = sb_m3_ddot(r, gap);
    return mesh->volumes[tet] * (lame[1] * sb_m3_ddot(gap, gap) + (sb_real)0.5 * lame[0] * trace * trace);
}

NDL_API ndl_tissue_energies ndl_tissue_get_energies(const ndl_tissue *tissue)
{
    const ndl_tissue_mesh *mesh = tissue ? &tissue->mesh : NULL;
    double elastic = 0, kinetic = 0;
    ndl_tissue_energies energies;
    energies.elastic = energies.kinetic = 0;
    if (!mesh)
        return energies;
    for (int e = 0; e < mesh->tet_end; e++)
        if (mesh->tets[4 * (size_t)e] >= 0)
            elastic += (double)ndli_solid_energy(tissue, e);
    for (int i = 0; i < mesh->node_end; i++)
        if (mesh->node_flags[i])
            kinetic += 0.5 * (double)mesh->mass[i] * (double)sb_v3_dot(mesh->v[i], mesh->v[i]);
    energies.elastic = (sb_real)elastic;
    energies.kinetic = (sb_real)kinetic;
    return energies;
}

NDL_API sb_vec3 ndl_tissue_momentum(const ndl_tissue *tissue)
{
    const ndl_tissue_mesh *mesh = tissue ? &tissue->mesh : NULL;
    double sum[3] = {0, 0, 0};
    if (!mesh)
        return sb_v3(0, 0, 0);
    for (int i = 0; i < mesh->node_end; i++)
        if (mesh->node_flags[i]) {
            sum[0] += (double)mesh->mass[i] * (double)mesh->v[i].x;
            sum[1] += (double)mesh->mass[i] * (double)mesh->v[i].y;
            sum[2] += (double)mesh->mass[i] * (double)mesh->v[i].z;
        }
    return sb_v3((sb_real)sum[0], (sb_real)sum[1], (sb_real)sum[2]);
}

NDL_API sb_mat3 ndl_tissue_stiffness(const ndl_tissue *tissue, int i, int j)
{
    sb_mat3 k = sb_m3_zero();
    const sb_real *block;
    int place;
    if (!tissue)
        return sb_m3_zero();
    if (tissue->broken || !ndli_solid_knows(tissue, i) || !ndli_solid_knows(tissue, j))
        return k;
    place = i == j || tissue->row_count[i] == 0 ? -1 : ndli_solid_find(tissue, i, j);
    if (i != j && place < 0)
        return k;
    block = i == j ? tissue->diagonal[i] : tissue->blocks[place];
    for (int c = 0; c < 9; c++)
        k.m[c / 3][c % 3] = block[c];
    return k;
}
