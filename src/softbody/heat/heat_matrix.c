/* heat_matrix: the pattern of nodes that share an element, conduction and what nodes have of volumes. */
#include "heat_private.h"

#include <string.h>

/* ---- pattern ---- */

/* Sorts a short list. */
static void sbi_heat_sort(int *list, int count)
{
    for (int i = 1; i < count; i++) {
        int value = list[i], at = i;
        for (; at > 0 && list[at - 1] > value; at--)
            list[at] = list[at - 1];
        list[at] = value;
    }
}

SBI_API int sbi_heat_pattern(const sb_body *body, int *mark, int *row_start, int *columns, int *diagonal)
{
    const sb_domain *domain = &body->domain;
    const sb_index_lists *lists = &body->node_elements;
    size_t count = 0;
    for (int i = 0; i < domain->node_count; i++)
        mark[i] = -1;
    row_start[0] = 0;
    for (int i = 0; i < domain->node_count; i++) {
        size_t first = count;
        mark[i] = i;
        if (columns)
            columns[count] = i;
        count++;
        for (int k = lists->offsets[i]; k < lists->offsets[i + 1]; k++) {
            const int *cell = domain->cells + (size_t)lists->items[k] * (size_t)domain->nodes_per_cell;
            for (int a = 0; a < domain->nodes_per_cell; a++) {
                if (mark[cell[a]] == i)
                    continue;
                mark[cell[a]] = i;
                if (columns)
                    columns[count] = cell[a];
                count++;
            }
        }
        if (count > INT32_MAX)
            return -1;
        row_start[i + 1] = (int)count;
        if (!columns)
            continue;
        sbi_heat_sort(columns + first, (int)(count - first));
        for (size_t q = first; q < count; q++)
            if (columns[q] == i)
                diagonal[i] = (int)q;
    }
    return (int)count;
}

SBI_API int sbi_heat_find(const sb_heat *heat, int i, int j)
{
    int low = heat->row_start[i], high = heat->row_start[i + 1];
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (heat->columns[middle] < j)
            low = middle + 1;
        else
            high = middle;
    }
    return low < heat->row_start[i + 1] && heat->columns[low] == j ? low : -1;
}

/* ---- integrals ---- */

static const sb_heat_tissue *sbi_heat_tissue_of(const sb_heat_def *def, int region)
{
    for (int k = 0; k < def->region_count; k++)
        if (def->regions[k].region == region)
            return &def->regions[k].tissue;
    return &def->tissue;
}

/* conduction += int k grad N_a . grad N_b of a cell, at the points that its stiffness has: exact where that is. */
static void sbi_heat_add_conduction(sb_heat *heat, int e, double conductivity)
{
    const sb_domain *domain = &heat->body->domain;
    int n = domain->nodes_per_cell, q = domain->points_per_cell;
    const int *cell = domain->cells + (size_t)e * (size_t)n;
    for (int a = 0; a < n; a++)
        for (int b = 0; b < n; b++) {
            double sum = 0;
            for (int p = 0; p < q - domain->mean_points; p++) {
                size_t at = (size_t)e * (size_t)q + (size_t)p;
                const sb_real *ga = domain->gradients + 3 * (at * (size_t)n + (size_t)a);
                const sb_real *gb = domain->gradients + 3 * (at * (size_t)n + (size_t)b);
                sum += (double)domain->weights[at] *
                       ((double)ga[0] * (double)gb[0] + (double)ga[1] * (double)gb[1] + (double)ga[2] * (double)gb[2]);
            }
            heat->conduction[sbi_heat_find(heat, cell[a], cell[b])] += conductivity * sum;
        }
}

SBI_API void sbi_heat_lumps(const sb_body *body, int e, sb_real *volumes)
{
    const sb_domain *domain = &body->domain;
    int n = domain->nodes_per_cell;
    const int *cell = domain->cells + (size_t)e * (size_t)n;
    sb_real mass[SB_MAX_ELEMENT_NODES * SB_MAX_ELEMENT_NODES];
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    memset(x, 0, sizeof x);
    for (int a = 0; a < n; a++)
        x[a] = body->reference[cell[a]];
    sbi_domain_element_mass(domain, e, SB_MASS_LUMPED, x, mass, NULL);
    for (int a = 0; a < n; a++)
        volumes[a] = mass[a * n + a];
}

/* What the nodes of a cell have of it. */
static void sbi_heat_add_lumps(sb_heat *heat, int e, const sb_heat_tissue *tissue)
{
    const sb_domain *domain = &heat->body->domain;
    const int *cell = domain->cells + (size_t)e * (size_t)domain->nodes_per_cell;
    sb_real volumes[SB_MAX_ELEMENT_NODES];
    sbi_heat_lumps(heat->body, e, volumes);
    for (int a = 0; a < domain->nodes_per_cell; a++) {
        double volume = (double)volumes[a];
        heat->volume[cell[a]] += volume;
        heat->capacity[cell[a]] += volume * (double)tissue->capacity;
        heat->latent[cell[a]] += volume * (double)tissue->latent_heat;
        heat->perfusion[cell[a]] += volume * (double)tissue->perfusion;
        heat->metabolic[cell[a]] += volume * (double)tissue->metabolic;
    }
}

SBI_API void sbi_heat_integrate(sb_heat *heat, const sb_heat_def *def)
{
    const sb_body *body = heat->body;
    for (int e = 0; e < body->domain.cell_count; e++) {
        sb_heat_tissue tissue = *sbi_heat_tissue_of(def, body->material_regions[body->cell_material[e]]);
        if (def->perfusion)
            tissue.perfusion = def->perfusion[e];
        if (def->metabolic)
            tissue.metabolic = def->metabolic[e];
        sbi_heat_add_conduction(heat, e, (double)tissue.conductivity);
        sbi_heat_add_lumps(heat, e, &tissue);
        heat->has_latent |= tissue.latent_heat > 0;
    }
}

SBI_API void sbi_heat_conduct(const sb_heat *heat, const double *x, double *y)
{
    for (int i = 0; i < heat->node_count; i++) {
        double sum = 0;
        for (int q = heat->row_start[i]; q < heat->row_start[i + 1]; q++)
            sum += heat->conduction[q] * x[heat->columns[q]];
        y[i] = sum;
    }
}
