/* couple_rows: see couple_rows.h. */
#include "couple_rows.h"

/* Rod nodes of hold i, and their shares. */
typedef struct ndli_rows_ends {
    int count, node[2];
    double share[2];
} ndli_rows_ends;

static ndli_rows_ends ndli_rows_get_ends(const ndli_line *line, int i)
{
    double share = line->holds[i].share;
    ndli_rows_ends ends;
    ends.count = share > 0 ? 2 : 1;
    ends.node[0] = i, ends.node[1] = i + 1;
    ends.share[0] = 1 - share, ends.share[1] = share;
    return ends;
}

/* Past the tissue: what the rod's motion [nodes], over the whole step, and the nodes' add to s. */
static ndli_v3 ndli_rows_way(const ndli_line *line, int i, const double *nodes)
{
    const struct ndli_hold *hold = line->holds + i;
    ndli_rows_ends ends = ndli_rows_get_ends(line, i);
    ndli_v3 way = ndli_v(0, 0, 0);
    for (int e = 0; e < ends.count; e++)
        way = ndli_madd(way, ends.share[e], line->motion[ends.node[e]]);
    for (int a = 0; a < hold->count; a++) {
        const double *u = nodes + 3 * (size_t)hold->places[a];
        way = ndli_madd(way, -hold->weights[a] / line->level, ndli_v(u[0], u[1], u[2]));
    }
    return way;
}

/* Of what a hold's spring takes up, the share that slip does not, for its viscous friction: 1 without such. */
static double ndli_rows_give(const ndli_line *line, int i)
{
    double k = line->holds[i].along;
    return k > 0 ? k / (k + ndli_line_viscosity(line, i)) : 0;
}

/* Stiffness along (N/m) in the present state of friction: of a slipping hold that of viscous friction behind its
 * spring. */
static double ndli_rows_along(const ndli_line *line, int i)
{
    if (!ndli_line_is_slipping(line, i))
        return line->holds[i].along;
    return ndli_rows_give(line, i) * ndli_line_viscosity(line, i);
}

static ndli_v3 ndli_rows_spring(const ndli_line *line, int i, ndli_v3 s)
{
    const struct ndli_hold *hold = line->holds + i;
    double along = ndli_dot(hold->tangent, s);
    ndli_v3 across = ndli_madd(s, -along, hold->tangent);
    return ndli_madd(ndli_scale(-hold->across, across), -ndli_rows_along(line, i) * along, hold->tangent);
}

/* Force of the tissue on the rod (N) after a way. */
static ndli_v3 ndli_rows_force(const ndli_line *line, int i, ndli_v3 way)
{
    const struct ndli_hold *hold = line->holds + i;
    ndli_v3 force = ndli_rows_spring(line, i, ndli_add(hold->offset, way));
    if (hold->count == 0)
        return ndli_v(0, 0, 0);
    if (ndli_line_is_slipping(line, i))
        force = ndli_madd(force, ndli_rows_give(line, i) * ndli_line_drag(line, i), hold->tangent);
    return force;
}

NDLI_API void ndli_rows_apply(ndli_line *line, int loads, const double *nodes, double *out_unknown, double *out_nodes)
{
    for (int i = ndli_line_rearmost(line); i <= ndli_line_foremost(line); i++) {
        const struct ndli_hold *hold = line->holds + i;
        ndli_rows_ends ends = ndli_rows_get_ends(line, i);
        ndli_v3 way = ndli_rows_way(line, i, nodes), force, on_tissue;
        if (hold->count == 0)
            continue;
        force = ndli_scale(line->level,
                           loads ? ndli_rows_force(line, i, way) : ndli_scale(-1, ndli_rows_spring(line, i, way)));
        for (int e = 0; e < ends.count; e++)
            if (!line->rod->held[ends.node[e]])
                ndli_line_add_to(out_unknown, NDLI_LINE_UNKNOWNS, ends.node[e], ends.share[e], force);
        on_tissue = ndli_scale(-1, force);
        if (loads)
            on_tissue = ndli_madd(on_tissue, line->level - 1, line->before[i]);
        for (int a = 0; a < hold->count; a++)
            ndli_line_add_to(out_nodes, 3, hold->places[a], hold->weights[a], on_tissue);
    }
}

/* ---- the rod's block ---- */

static ndli_m3 ndli_rows_matrix(const ndli_line *line, int i)
{
    const struct ndli_hold *hold = line->holds + i;
    ndli_m3 k = ndli_m_zero();
    ndli_m_add_identity(&k, hold->across);
    ndli_m_add_outer(&k, ndli_rows_along(line, i) - hold->across, hold->tangent, hold->tangent);
    return k;
}

NDLI_API void ndli_rows_add_band(ndli_line *line)
{
    for (int i = ndli_line_rearmost(line); i <= ndli_line_foremost(line); i++) {
        ndli_rows_ends ends = ndli_rows_get_ends(line, i);
        ndli_m3 k = ndli_rows_matrix(line, i);
        for (int a = 0; a < ends.count && line->holds[i].count > 0; a++)
            for (int b = 0; b <= a; b++)
                if (!line->rod->held[ends.node[a]] && !line->rod->held[ends.node[b]])
                    ndli_line_add_to_band(line, ends.node[a], ends.node[b], ends.share[a] * ends.share[b], &k);
    }
}

/* ---- results ---- */

NDLI_API void ndli_rows_read(ndli_line *line, const double *nodes)
{
    for (int i = ndli_line_rearmost(line); i <= ndli_line_foremost(line); i++) {
        const struct ndli_hold *hold = line->holds + i;
        ndli_rows_ends ends = ndli_rows_get_ends(line, i);
        ndli_v3 way = ndli_rows_way(line, i, nodes), force = ndli_rows_force(line, i, way);
        double along = ndli_dot(hold->tangent, ndli_add(hold->offset, way));
        line->contact[i] = force;
        if (hold->count == 0) /* nothing is there: it goes on as the rod does */
            line->slip[i] = ndli_dot(hold->tangent, way);
        else if (ndli_line_is_slipping(line, i)) /* what the spring is wound by does not slip */
            line->slip[i] = along + ndli_dot(hold->tangent, force) / hold->along;
        for (int e = 0; e < ends.count; e++)
            if (line->rod->held[ends.node[e]])
                line->reaction[ends.node[e]] = ndli_madd(line->reaction[ends.node[e]], -ends.share[e], force);
    }
}
