/* prior: see prior.h. */
#include "prior.h"

#include <math.h>
#include <string.h>

#include "../softbody/fem/domain.h"
#include "cloud.h"
#include "gauss.h"

/* Work while a prior is made. */
typedef struct regi_prior_draft {
    const sb_mesh *skin;
    const int *nodes; /* [skin nodes] of the organ */
    int *chosen;      /* [c] skin nodes */
    sb_real *scratch; /* [skin nodes] */
    sb_real *psi;     /* [skin nodes][c] */
    sb_real *full;    /* [skin nodes][c] shares */
} regi_prior_draft;

static void regi_prior_layout_draft(regi_prior_draft *draft, int controls, sbi_arena *arena)
{
    size_t n = (size_t)draft->skin->node_count, c = (size_t)controls;
    draft->chosen = (int *)sbi_arena_take(arena, c, sizeof(int));
    draft->scratch = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    draft->psi = (sb_real *)sbi_arena_take(arena, n, c * sizeof(sb_real));
    draft->full = (sb_real *)sbi_arena_take(arena, n, c * sizeof(sb_real));
}

static void regi_prior_layout(regi_prior *p, sbi_arena *arena)
{
    size_t n = (size_t)p->node_count, c = (size_t)p->control_count;
    p->places = (sb_vec3 *)sbi_arena_take(arena, c, sizeof(sb_vec3));
    p->areas = (double *)sbi_arena_take(arena, c, sizeof(double));
    p->calm = (double *)sbi_arena_take(arena, c, sizeof(double));
    p->start = (int *)sbi_arena_take(arena, n + 1, sizeof(int));
    p->weight = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
}

/* psi at the nodes of the skin: Shepard weights (1 - r/reach)^2 with a reach of twice the spacing, which every node has
 * a few control points within. With all nodes chosen each has its own. */
static void regi_prior_spread(const regi_prior *p, const regi_prior_draft *draft)
{
    int nodes = draft->skin->node_count, c = p->control_count;
    sb_real spacing = 0, reach;
    for (int i = 0; i < nodes; i++) {
        sb_real *row = draft->psi + (size_t)i * (size_t)c, nearest = SB_REAL_MAX;
        for (int j = 0; j < c; j++) {
            row[j] = sb_v3_norm(sb_v3_sub(draft->skin->nodes[i], p->places[j]));
            nearest = sb_min(nearest, row[j]);
        }
        spacing = sb_max(spacing, nearest);
    }
    reach = (sb_real)1.5 * spacing;
    if (!(reach > 0)) /* nodes in one place */
        reach = (sb_real)(1e-6 * p->size);
    for (int i = 0; i < nodes; i++) {
        sb_real *row = draft->psi + (size_t)i * (size_t)c, sum = 0;
        for (int j = 0; j < c; j++) {
            sb_real r = row[j];
            row[j] = c == nodes ? (sb_real)(draft->chosen[j] == i) : r < reach ? (1 - r / reach) * (1 - r / reach) : 0;
            sum += row[j];
        }
        for (int j = 0; j < c; j++)
            row[j] /= sum;
    }
}

/* Adds what one facet bears: w N_a sum_b N_b psi_b at its points. */
static void regi_prior_add_facet(regi_prior *p, const regi_prior_draft *draft, const int *corners, int width)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    size_t c = (size_t)p->control_count;
    int count = sb_element_quadrature(draft->skin->element_type, SB_QUADRATURE_FACE, points, weights);
    for (int q = 0; q < count; q++) {
        sb_real shape[SB_MAX_ELEMENT_NODES], slope[SB_MAX_ELEMENT_NODES][3], w;
        sb_vec3 along = sb_v3(0, 0, 0), across = sb_v3(0, 0, 0);
        sb_element_shape(draft->skin->element_type, points[q], shape, slope);
        for (int a = 0; a < width; a++) {
            along = sb_v3_madd(along, slope[a][0], draft->skin->nodes[corners[a]]);
            across = sb_v3_madd(across, slope[a][1], draft->skin->nodes[corners[a]]);
        }
        w = weights[q] * sb_v3_norm(sb_v3_cross(along, across));
        p->area += (double)w;
        for (size_t j = 0; j < c; j++) {
            sb_real psi = 0;
            for (int b = 0; b < width; b++)
                psi += shape[b] * draft->psi[(size_t)corners[b] * c + j];
            if (psi == 0)
                continue;
            p->areas[j] += (double)(w * psi);
            for (int a = 0; a < width; a++)
                draft->full[(size_t)corners[a] * c + j] += w * psi * shape[a];
        }
    }
}

/* Shares of the nodes, without those of control points that do not act there. */
static sb_result regi_prior_list(regi_prior *p, const regi_prior_draft *draft, sb_error *error)
{
    size_t c = (size_t)p->control_count, at = 0, all;
    int nodes = draft->skin->node_count, next = 0;
    size_t count = 0;
    for (size_t k = 0; k < (size_t)nodes * c; k++)
        count += draft->full[k] != 0;
    all = count * sizeof(int);
    all = (all + 63) / 64 * 64;
    p->lists = sbi_alloc(&p->allocator, all + count * sizeof(sb_real), 1);
    if (!p->lists)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the loads of %d nodes", nodes);
    p->controls = (int *)p->lists;
    p->shares = (sb_real *)(void *)((unsigned char *)p->lists + all);
    for (int i = 0; i < p->node_count; i++) { /* compact boundaries keep the order of the nodes */
        p->start[i] = (int)at;
        if (next == nodes || draft->nodes[next] != i)
            continue;
        for (size_t j = 0; j < c; j++)
            if (draft->full[(size_t)next * c + j] != 0) {
                p->controls[at] = (int)j;
                p->shares[at++] = draft->full[(size_t)next * c + j];
            }
        next++;
    }
    p->start[p->node_count] = (int)at;
    return SB_OK;
}

/* int N_a dV / V */
static sb_result regi_prior_weigh(regi_prior *p, const sb_mesh *mesh, sb_error *error)
{
    sbi_element element = sbi_element_make(mesh->element_type, mesh->table);
    int width = sb_mesh_element_width(mesh);
    double volume = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = mesh->elements + (size_t)e * (size_t)width;
        sb_vec3 x[SB_MAX_ELEMENT_NODES];
        sb_real mass[SB_MAX_ELEMENT_NODES * SB_MAX_ELEMENT_NODES], load[SB_MAX_ELEMENT_NODES];
        for (int a = 0; a < width; a++)
            x[a] = mesh->nodes[nodes[a]];
        sbi_element_mass(element, SB_MASS_CONSISTENT, x, mass, load);
        for (int a = 0; a < width; a++) {
            p->weight[nodes[a]] += load[a];
            volume += (double)load[a];
        }
    }
    if (!(volume > 0) || !(p->area > 0))
        return sbi_fail(error, SB_ERROR_MESH, "an organ of %g m^3 and %g m^2 bears no loads", volume, p->area);
    for (int i = 0; i < p->node_count; i++)
        p->weight[i] = (sb_real)((double)p->weight[i] / volume);
    return SB_OK;
}

static sb_result regi_prior_fill(regi_prior *p, const sb_mesh *mesh, regi_prior_draft *draft, sb_error *error)
{
    int width = sb_mesh_element_width(draft->skin);
    sb_result result;
    for (int j = 0; j < p->control_count; j++) {
        p->places[j] = draft->skin->nodes[draft->chosen[j]];
        p->calm[j] = 1;
    }
    regi_prior_spread(p, draft);
    for (int f = 0; f < draft->skin->element_count; f++)
        regi_prior_add_facet(p, draft, draft->skin->elements + (size_t)f * (size_t)width, width);
    result = regi_prior_list(p, draft, error);
    return result == SB_OK ? regi_prior_weigh(p, mesh, error) : result;
}

REGI_API sb_result regi_prior_create(const sb_mesh *mesh, const sb_boundary *boundary, const sb_allocator *allocator,
                                     regi_prior *prior, sb_error *error)
{
    regi_prior p;
    regi_prior_draft draft;
    sbi_arena arena = {NULL, 0, 0};
    sb_vec3 low, high;
    void *scratch;
    int wanted = sbi_min_int(boundary->surface.node_count, REGI_PRIOR_CONTROLS);
    sb_result result;
    memset(&p, 0, sizeof p);
    memset(&draft, 0, sizeof draft);
    if (allocator)
        p.allocator = *allocator;
    draft.skin = &boundary->surface;
    draft.nodes = boundary->nodes;
    p.node_count = mesh->node_count;
    p.wide = sbi_lanes_are_wide();
    sb_mesh_bounds(mesh, &low, &high);
    p.size = (double)sb_v3_norm(sb_v3_sub(high, low));
    regi_prior_layout_draft(&draft, wanted, &arena);
    scratch = arena.overflow ? NULL : sbi_alloc_zeroed(&p.allocator, 1, arena.used);
    if (!scratch)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the loads of %d nodes", draft.skin->node_count);
    arena.base = (unsigned char *)scratch;
    arena.used = 0;
    regi_prior_layout_draft(&draft, wanted, &arena);
    p.control_count = reg_cloud_spread(draft.skin->nodes, draft.skin->node_count, wanted, draft.chosen, draft.scratch);
    memset(&arena, 0, sizeof arena);
    regi_prior_layout(&p, &arena);
    p.memory = arena.overflow ? NULL : sbi_alloc_zeroed(&p.allocator, 1, arena.used);
    if (p.memory) {
        arena.base = (unsigned char *)p.memory;
        arena.used = 0;
        regi_prior_layout(&p, &arena);
        result = regi_prior_fill(&p, mesh, &draft, error);
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the loads of %d nodes", p.node_count);
    }
    sbi_free(&p.allocator, scratch);
    if (result == SB_OK)
        *prior = p;
    else
        regi_prior_free(&p);
    return result;
}

REGI_API void regi_prior_free(regi_prior *prior)
{
    sbi_free(&prior->allocator, prior->memory);
    sbi_free(&prior->allocator, prior->lists);
    memset(prior, 0, sizeof *prior);
}

REGI_API void regi_prior_forces(const regi_prior *p, const sb_vec3 *tractions, sb_vec3 weight, sb_vec3 *forces)
{
    for (int i = 0; i < p->node_count; i++) {
        forces[i] = sb_v3_scale(p->weight[i], weight);
        for (int k = p->start[i]; k < p->start[i + 1]; k++)
            forces[i] = sb_v3_madd(forces[i], p->shares[k], tractions[p->controls[k]]);
    }
}

REGI_API void regi_prior_collect(const regi_prior *p, const sb_vec3 *row, sb_vec3 *out, sb_vec3 *weight)
{
    memset(out, 0, (size_t)p->control_count * sizeof *out);
    *weight = sb_v3(0, 0, 0);
    for (int i = 0; i < p->node_count; i++) {
        *weight = sb_v3_madd(*weight, p->weight[i], row[i]);
        for (int k = p->start[i]; k < p->start[i + 1]; k++)
            out[p->controls[k]] = sb_v3_madd(out[p->controls[k]], p->shares[k], row[i]);
    }
}

/* Matern 3/2 */
static double regi_prior_kernel(double z)
{
    double t = 1.7320508075688772 * z;
    return (1 + t) * sbi_dense_exp(-t);
}

static double regi_prior_apart(const regi_prior *p, int i, int j)
{
    return (double)sb_v3_norm(sb_v3_sub(p->places[i], p->places[j]));
}

REGI_API int regi_prior_root(const regi_prior *p, double length, const double *local, double *root)
{
    int c = p->control_count;
    for (int i = 0; i < c; i++)
        for (int j = i; j < c; j++) {
            double scale = p->calm[i] * p->calm[j] * (local ? local[i] * local[j] : 1);
            root[(size_t)i * (size_t)c + (size_t)j] =
                scale * (regi_prior_kernel(regi_prior_apart(p, i, j) / (length * p->size)) + (i == j ? 1e-9 : 0));
        }
    if (!regi_gauss_cholesky(p->wide, root, c, (size_t)c))
        return 0;
    for (int i = 0; i < c; i++) /* U^T is the lower root */
        for (int j = i + 1; j < c; j++) {
            root[(size_t)j * (size_t)c + (size_t)i] = root[(size_t)i * (size_t)c + (size_t)j];
            root[(size_t)i * (size_t)c + (size_t)j] = 0;
        }
    return 1;
}

/* What is expected at a control point, as if it bore loads like any other. */
static double regi_prior_energy(const regi_prior *p, const double *energy, int control)
{
    return energy[control] / (p->calm[control] * p->calm[control]);
}

/* d^2 = (nu phi + energy) / (nu + 1) over the mean; energies are averaged with a Gaussian of l / 2 first. What is not
 * seen keeps the variance that it has, so that nothing is declared free of loads because nobody looked. */
REGI_API void regi_prior_localise(const regi_prior *p, double length, const double *energy, double *local)
{
    const double phi = 0.2, nu = 1, degrees = 3;
    int c = p->control_count;
    double mean = 0, area = 0, reach = 0.5 * length * p->size;
    for (int i = 0; i < c; i++) {
        mean += p->areas[i] * regi_prior_energy(p, energy, i);
        area += p->areas[i];
    }
    mean /= area;
    area = 0;
    for (int i = 0; i < c; i++) {
        double sum = 0, weights = 0;
        for (int j = 0; j < c; j++) {
            double z = regi_prior_apart(p, i, j) / reach, w = p->areas[j] * sbi_dense_exp(-0.5 * z * z);
            sum += w * regi_prior_energy(p, energy, j);
            weights += w;
        }
        local[i] = (nu * phi * mean + degrees * sum / weights) / (nu + degrees);
        area += p->areas[i];
    }
    mean = 0;
    for (int i = 0; i < c; i++)
        mean += p->areas[i] * local[i] / area;
    for (int i = 0; i < c; i++)
        local[i] = mean > 0 ? sqrt(local[i] / mean) : 1;
}
