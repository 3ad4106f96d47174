/* needle_resist: what the tissue does to a needle: friction along it, forces that its tip must cut with. */
#include "needle_private.h"

#include <string.h>

/* ---- friction ---- */

/* Mean over the tets of a tissue node, by volume. */
static void ndli_resist_at(const ndl_needle *needle, int node, double mean[5])
{
    const ndli_topology *mesh = needle->site->mesh;
    double total = 0;
    memset(mean, 0, 5 * sizeof *mean);
    for (int k = mesh->node_star[node]; k >= 0; k = mesh->corner_next[k]) {
        const ndl_friction *f = ndli_needle_friction(needle, mesh->regions[k / 4]);
        double volume = (double)mesh->volumes[k / 4];
        total += volume;
        if (!f)
            continue;
        mean[0] += volume * (double)f->friction;
        mean[1] += volume * (double)f->viscous;
        mean[2] += volume * (double)f->cutting;
        mean[3] += volume * (double)f->twist_stiffness;
        mean[4] += volume * (double)f->twist_friction;
    }
    for (int i = 0; i < 5 && total > 0; i++)
        mean[i] /= total;
}

/* ---- cutting ---- */

/* The region that the tip looks into. */
static int ndli_resist_region_ahead(const ndl_needle *needle, int tip)
{
    const ndli_topology *mesh = needle->site->mesh;
    sb_vec3 t = ndli_to(needle->rod->tangent[needle->rod->node_count - 2]);
    sb_real best = -SB_REAL_MAX;
    int region = -1;
    for (int k = mesh->node_star[tip]; k >= 0; k = mesh->corner_next[k]) {
        const int *n = mesh->tets + 4 * (size_t)(k / 4);
        sb_vec3 sum = sb_v3_add(sb_v3_add(mesh->x[n[0]], mesh->x[n[1]]), sb_v3_add(mesh->x[n[2]], mesh->x[n[3]]));
        sb_vec3 way = sb_v3_sub(sb_v3_scale((sb_real)0.25, sum), mesh->x[tip]);
        sb_real ahead = sb_v3_dot(way, t) / sb_v3_norm(way);
        if (ahead > best) {
            best = ahead;
            region = mesh->regions[k / 4];
        }
    }
    return region;
}

NDLI_API double ndli_needle_cutting_at(const ndl_needle *needle, sb_vec3 X, int region, double table)
{
    if (needle->cutting_at) {
        sb_real force = needle->cutting_at(needle->cutting_user, X, region);
        return force > 0 && sb_is_finite(force) ? (double)force : 0;
    }
    return ndli_needle_cut_membranes(needle, X, table);
}

static double ndli_resist_cutting(const ndl_needle *needle, int tip, double table)
{
    sb_vec3 X;
    ndl_needle_tip_material(needle, &X);
    return ndli_needle_cutting_at(needle, X, needle->cutting_at ? ndli_resist_region_ahead(needle, tip) : 0, table);
}

/* A tip that comes near the skin from inside is stopped: nothing can follow it out, and tets ahead of it get flat. */
static int ndli_resist_is_at_skin(const ndl_needle *needle)
{
    const ndli_topology *mesh = needle->site->mesh;
    int tip;
    sb_real ahead = (sb_real)(0.2 * needle->site->mean_edge);
    sb_vec3 way;
    if (needle->shallow || needle->line.count < 2)
        return 0;
    tip = needle->path[needle->line.count - 1];
    way = sb_v3_sub(mesh->X[tip], mesh->X[needle->path[needle->line.count - 2]]);
    return ndli_topology_find(mesh, mesh->X, sb_v3_madd(mesh->X[tip], ahead / sb_v3_norm(way), way),
                              mesh->node_star[tip] / 4, NULL) < 0;
}

/* What the tip has to cut, or what nothing can overcome. */
static void ndli_resist_tip(ndl_needle *needle, int tip, double table)
{
    ndli_line *line = &needle->line;
    int last = ndli_line_foremost(line);
    line->cutting = ndli_resist_cutting(needle, tip, table);
    if (needle->hold_steps == 0 && !ndli_resist_is_at_skin(needle))
        return;
    needle->blocked = 1;
    line->cutting = (double)SB_REAL_MAX;
    if (line->state[last] == NDL_DYNAMIC_FORWARD)
        line->state[last] = NDL_STATIC;
}

/* ---- all of it ---- */

NDLI_API void ndli_needle_resist(ndl_needle *needle)
{
    ndl_rod *rod = needle->rod;
    ndli_line *line = &needle->line;
    int last = ndli_line_foremost(line), ends = rod->node_count - 1;
    double before[5] = {0, 0, 0, 0, 0}, here[5];
    line->cutting = 0;
    for (int i = line->first; i <= last; i++) {
        int tip = needle->path[i - line->first];
        double behind = i > line->first ? ndli_norm(ndli_sub(rod->x[i], rod->x[i - 1])) : 0;
        double ahead = i < ends ? ndli_norm(ndli_sub(rod->x[i + 1], rod->x[i])) : 0;
        double length = 0.5 * (behind + ahead) + (i == last ? 0.5 * ahead : 0); /* a shallow tip has no node */
        ndli_resist_at(needle, tip, here);
        line->friction[i] = length * here[0];
        line->viscous[i] = length * here[1];
        if (i == last && i < ends)
            ndl_rod_set_grip(rod, i, (sb_real)(ahead * here[3]), (sb_real)(ahead * here[4]));
        if (i == last)
            ndli_resist_tip(needle, tip, here[2]);
        if (i > line->first)
            ndl_rod_set_grip(rod, i - 1, (sb_real)(0.5 * behind * (before[3] + here[3])),
                             (sb_real)(0.5 * behind * (before[4] + here[4])));
        memcpy(before, here, sizeof before);
    }
    for (int j = 0; j < sbi_min_int(line->first, ends); j++)
        ndl_rod_set_grip(rod, j, 0, 0);
}
