/* body_particles: rows that hold particles to the linear fields of their points. */
#include "body_particles.h"
#include "body_private.h"
#include "load.h"
#include "../geometry/particles_private.h"

typedef struct sbi_stabilisation {
    int rows, entries, most_rows;
    int *start, *nodes;
    sb_real *weights, *stiffness;
    sb_vec3 *targets;
} sbi_stabilisation;

static void sbi_stabilise_lay_out(const sb_particles *particles, sbi_stabilisation *s, sbi_arena *arena)
{
    size_t n = (size_t)particles->domain.nodes_per_cell, rows = (size_t)particles->mesh.element_count * n;
    s->start = (int *)sbi_arena_take(arena, rows + 1, sizeof(int));
    s->stiffness = (sb_real *)sbi_arena_take(arena, rows, sizeof(sb_real));
    s->targets = (sb_vec3 *)sbi_arena_take(arena, rows, sizeof(sb_vec3));
    s->nodes = (int *)sbi_arena_take(arena, rows, n * sizeof(int));
    s->weights = (sb_real *)sbi_arena_take(arena, rows, n * sizeof(sb_real));
}

/* The row of node j of a point, B_a = delta_ja - phi_a - g_a . (X_j - X_p); its own particle has none. */
static void sbi_stabilise_row(const sb_particles *particles, int cell, int j, int count, double stiffness,
                              sbi_stabilisation *s)
{
    size_t first = (size_t)cell * (size_t)particles->domain.nodes_per_cell;
    const int *nodes = particles->domain.cells + first;
    const sb_real *g = particles->domain.gradients + 3 * first;
    sb_vec3 away = sb_v3_sub(particles->mesh.nodes[nodes[j]], particles->points[cell]);
    const double linear = SB_REAL_IS_FLOAT ? 1e-3 : 1e-6;
    double largest = 0;
    sb_vec3 rest = sb_v3(0, 0, 0);
    for (int a = 0; a < count; a++) {
        double b = (a == j ? 1 : 0) - (double)particles->shapes[first + (size_t)a] -
                   (double)sb_v3_dot(sb_v3(g[3 * a], g[3 * a + 1], g[3 * a + 2]), away);
        s->nodes[s->entries + a] = nodes[a];
        s->weights[s->entries + a] = (sb_real)b;
        largest = fmax(largest, fabs(b));
        rest = sb_v3_madd(rest, (sb_real)b, sb_v3_sub(particles->mesh.nodes[nodes[a]], particles->points[cell]));
    }
    if ((double)sb_v3_norm(rest) > linear * (double)particles->radii[cell]) /* a cut left it without a linear field */
        return;
    if (!(largest > 64 * (double)SB_EPSILON) || !(stiffness > 0))
        return;
    s->targets[s->rows] = sb_v3(0, 0, 0); /* what linear fields, and so places at rest, come to; see below */
    s->stiffness[s->rows] = (sb_real)stiffness;
    s->entries += count;
    s->start[++s->rows] = s->entries;
}

static void sbi_stabilise_cell(const sb_particles *particles, int cell, double modulus, sbi_stabilisation *s)
{
    int n = particles->domain.nodes_per_cell, count = sbi_particle_cell_count(particles, cell);
    const int *nodes = particles->domain.cells + (size_t)cell * (size_t)n;
    double h = (double)particles->radii[cell], sum = 0, weight[SBI_PARTICLE_NODES];
    for (int j = 0; j < count; j++) {
        sb_vec3 away = sb_v3_sub(particles->mesh.nodes[nodes[j]], particles->points[cell]);
        double square = (double)sb_v3_dot(away, away);
        weight[j] = h > 0 ? sbi_kernel_shape(particles->def.kernel, sqrt(square) / h) : 0;
        sum += weight[j] * square;
    }
    for (int j = 0; j < count && sum > 0; j++)
        sbi_stabilise_row(particles, cell, j, count,
                          modulus * (double)particles->domain.weights[cell] * weight[j] / sum, s);
}

/* Rows are of positions: their targets are what rest comes to, which is 0 but for rounding. */
static void sbi_stabilise_rest(const sb_particles *particles, sbi_stabilisation *s, sb_mapping *mapping)
{
    mapping->row_count = s->rows;
    mapping->row_start = s->start;
    mapping->nodes = s->nodes;
    mapping->weights = s->weights;
    sb_mapping_apply(mapping, particles->mesh.nodes, s->targets);
}

static sb_result sbi_stabilise_check(const sb_particles *particles, const sb_body *body, sb_real alpha, sb_error *error)
{
    if (!particles || !particles->table || !body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_particles_stabilise needs particles and a body");
    if (!(alpha > 0) || !(alpha <= 10))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "alpha %g must be in (0, 10]", (double)alpha);
    if (body->domain.table != particles->table || body->domain.cell_count != particles->mesh.element_count ||
        body->domain.node_count != particles->mesh.node_count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the body was not made of these particles");
    if (particles->def.method == SB_PARTICLES_SPH ||
        (particles->def.method == SB_PARTICLES_GRID && particles->def.basis == 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "these gradients miss linear fields, which would be held, too");
    return SB_OK;
}

SB_API sb_result sb_particles_stabilise(const sb_particles *particles, sb_body *body, sb_real alpha, int *load_id,
                                        sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    sbi_stabilisation s;
    sb_mapping mapping;
    void *memory = NULL;
    sb_result result = sbi_stabilise_check(particles, body, alpha, error);
    if (result != SB_OK)
        return result;
    memset(&s, 0, sizeof s);
    sbi_stabilise_lay_out(particles, &s, &arena);
    memory = arena.overflow ? NULL : sbi_alloc(&body->allocator, arena.used, 1);
    if (!memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the rows of %d points", particles->mesh.element_count);
    arena.base = (unsigned char *)memory;
    arena.used = 0;
    sbi_stabilise_lay_out(particles, &s, &arena);
    s.start[0] = 0;
    for (int e = 0; e < particles->mesh.element_count; e++) {
        const sb_material *material = body->materials + body->cell_material[e];
        sbi_stabilise_cell(particles, e, (double)alpha * (double)(material->lambda + 2 * material->mu), &s);
    }
    sbi_stabilise_rest(particles, &s, &mapping);
    if (s.rows > 0)
        result = sb_body_add_mapping(body, &mapping, s.stiffness, 0, s.targets, load_id, error);
    sbi_free(&body->allocator, memory);
    return result;
}
