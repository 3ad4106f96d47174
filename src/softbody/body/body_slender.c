/* body_slender: how thin a body is, which tells how its static solves go about. */
#include <string.h>

#include "body_private.h"

/* areas[node_count] += int grad N_a dV of a cell's nodes: in all the integral of N_a n over the surface (m^2), nothing
 * inside the body. Returns the cell's volume. */
static double sbi_body_add_areas(const sb_domain *d, int cell, sb_vec3 *areas)
{
    size_t n = (size_t)d->nodes_per_cell, first = (size_t)cell * (size_t)d->points_per_cell;
    const int *nodes = d->cells + (size_t)cell * n;
    double volume = 0;
    for (int p = 0; p < d->points_per_cell - d->mean_points; p++) {
        sb_real w = d->weights[first + (size_t)p];
        const sb_real *g = d->gradients + (first + (size_t)p) * n * 3;
        for (size_t a = 0; a < n; a++)
            areas[nodes[a]] = sb_v3_madd(areas[nodes[a]], w, sb_v3(g[3 * a], g[3 * a + 1], g[3 * a + 2]));
        volume += (double)w;
    }
    return volume;
}

SB_API sb_real sb_body_slenderness(const sb_body *body)
{
    double area = 0, volume = 0;
    if (!body)
        return 0;
    memset(body->work, 0, (size_t)body->domain.node_count * sizeof(sb_vec3));
    for (int e = 0; e < body->domain.cell_count; e++)
        if (!sbi_domain_is_free(&body->domain, e))
            volume += sbi_body_add_areas(&body->domain, e, body->work);
    for (int i = 0; i < body->domain.node_count; i++)
        area += (double)sb_v3_norm(body->work[i]);
    if (body->domain.element_type == SB_HEX20) /* corners take -1/12 of a side each, middles 1/3 */
        area *= 0.6;
    return volume > 0 ? (sb_real)((double)sbi_body_size(body) * area / (3 * volume)) : 0;
}
