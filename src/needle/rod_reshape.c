/* rod_reshape: other nodes on a rod's own curve. Needles slide along the nodes of their tissue: after a step the
 * coupled nodes go back to these, and what the rod carries is measured anew where they are.
 *
 * Arc distances of the new polyline are scaled to the old one's, so that both ends agree; between the ends of a
 * clamped base edge and beyond it by a scale of their own, so that the clamp keeps its edge. Interpolation is Akima's
 * (1970, "A new method of interpolation and smooth curve fitting based on local procedures"): local, without
 * overshoot next to straight data, but not monotone. */
#include "rod_private.h"

/* ---- interpolation ---- */

/* value[count] at the stations at[count], rising; slope[count] is Akima's. */
typedef struct ndli_rod_curve {
    double *at, *value, *slope;
    int count;
} ndli_rod_curve;

/* Slope from station i to the next; two beyond each end follow the parabola through the last three. */
static double ndli_rod_secant(const ndli_rod_curve *curve, int i)
{
    int last = curve->count - 2;
    if (last < 1) /* two stations: a straight line */
        i = 0;
    if (i < 0)
        return ndli_rod_secant(curve, 0) + i * (ndli_rod_secant(curve, 1) - ndli_rod_secant(curve, 0));
    if (i > last)
        return ndli_rod_secant(curve, last) +
               (i - last) * (ndli_rod_secant(curve, last) - ndli_rod_secant(curve, last - 1));
    return (curve->value[i + 1] - curve->value[i]) / (curve->at[i + 1] - curve->at[i]);
}

static void ndli_rod_set_slopes(ndli_rod_curve *curve)
{
    for (int i = 0; i < curve->count; i++) {
        double m[4], before, after;
        for (int k = 0; k < 4 && curve->count > 1; k++)
            m[k] = ndli_rod_secant(curve, i - 2 + k);
        if (curve->count < 2) {
            curve->slope[i] = 0;
            continue;
        }
        before = fabs(m[3] - m[2]);
        after = fabs(m[1] - m[0]);
        curve->slope[i] = before + after > 0 ? (before * m[1] + after * m[2]) / (before + after) : 0.5 * (m[1] + m[2]);
    }
}

/* The last station not beyond u, looked for from *cursor on, which only goes up; -1: u lies before all of them. */
static int ndli_rod_station(const double *at, int count, double u, int *cursor)
{
    while (*cursor + 1 < count && at[*cursor + 1] <= u)
        ++*cursor;
    return at[*cursor] <= u ? *cursor : -1;
}

/* Beyond the first and last station the curve goes on straight, by its slope there or (flat) by none. */
static double ndli_rod_curve_at(const ndli_rod_curve *curve, double u, int flat, int *cursor)
{
    int i = ndli_rod_station(curve->at, curve->count, u, cursor), outside = i < 0 || i == curve->count - 1;
    double d, width, m, s0, s1;
    i = sbi_max_int(i, 0);
    d = u - curve->at[i];
    s0 = curve->slope[i];
    if (outside)
        return curve->value[i] + (flat ? 0 : s0 * d);
    s1 = curve->slope[i + 1];
    width = curve->at[i + 1] - curve->at[i];
    m = ndli_rod_secant(curve, i);
    return curve->value[i] + d * (s0 + d / width * (3 * m - 2 * s0 - s1 + d / width * (s0 + s1 - 2 * m)));
}

/* ---- from the old nodes to the new ones ---- */

/* A reparameterisation while it is being made, all in the rod's scratch. */
typedef struct ndli_rod_reshape {
    int count;                   /* new nodes */
    const ndli_v3 *x;            /* [count] */
    ndli_v3 *v, *a;              /* [count] */
    ndli_v3 *tangent, *director; /* [count - 1] */
    double *old_at;              /* [old nodes] (m) arc distance of the old nodes */
    double *at;                  /* [count] the new nodes', on the same scale */
    double *length;              /* [count - 1] (m) */
    double *rest_length;         /* [count - 1] (m) */
    double *theta;               /* [count - 1] (rad) */
    double *curvature[2];        /* [count] (1/m) at rest; inner nodes */
    ndli_rod_spread grip;        /* [count - 1] */
    ndli_rod_curve curve;        /* what is interpolated; stations' room for the old nodes */
} ndli_rod_reshape;

/* Hands out the scratch: 13 of the 44 reals a node of rod->band, and node arrays but try_x. */
static ndli_rod_reshape ndli_rod_begin_reshape(ndl_rod *rod, const ndli_v3 *positions, int count)
{
    ndli_rod_reshape reshape;
    double *reals[13];
    for (int k = 0; k < 13; k++)
        reals[k] = rod->band + (size_t)k * (size_t)rod->capacity;
    reshape.count = count;
    reshape.x = positions;
    reshape.v = rod->best_x;
    reshape.a = rod->step_x;
    reshape.tangent = rod->predicted;
    reshape.director = rod->gradient;
    reshape.old_at = reals[0];
    reshape.at = reals[1];
    reshape.length = reals[2];
    reshape.rest_length = reals[3];
    reshape.theta = reals[4];
    reshape.curvature[0] = reals[5];
    reshape.curvature[1] = reals[6];
    reshape.curve.at = reals[7];
    reshape.curve.value = reals[8];
    reshape.curve.slope = reals[9];
    reshape.curve.count = 0;
    reshape.grip.grip = reals[10];
    reshape.grip.limit = reals[11];
    reshape.grip.lag = reals[12];
    return reshape;
}

/* Lengths and tangents of the new edges. -1, or the node at which there is no rod. */
static int ndli_rod_check_nodes(const ndl_rod *rod, ndli_rod_reshape *reshape)
{
    double reach = 0;
    for (int i = 0; i < reshape->count; i++)
        for (int k = 0; k < 3; k++) {
            if (!ndli_is_finite(ndli_component(reshape->x[i], k)))
                return i;
            reach = fmax(reach, fabs(ndli_component(reshape->x[i], k)));
        }
    for (int j = 0; j + 1 < reshape->count; j++) {
        ndli_v3 e = ndli_sub(reshape->x[j + 1], reshape->x[j]);
        double length = ndli_norm(e);
        if (!(length > 1e-12 * reach) || !ndli_is_finite(length))
            return j + 1;
        reshape->length[j] = length;
        reshape->tangent[j] = ndli_scale(1 / length, e);
        if (j > 0 && !ndli_rod_may_turn(reshape->tangent[j - 1], reshape->tangent[j]))
            return j;
    }
    return ndli_rod_may_turn(rod->tangent[0], reshape->tangent[0]) ? -1 : 1;
}

/* Stations of the old nodes and of the new ones. */
static void ndli_rod_set_stations(const ndl_rod *rod, ndli_rod_reshape *reshape)
{
    int n = rod->node_count, m = reshape->count, clamped = n > 2 && m > 2 && rod->held[0] && rod->held[1];
    double whole = 0, scale, *old = reshape->old_at, *at = reshape->at;
    old[0] = at[0] = 0;
    for (int i = 1; i < n; i++)
        old[i] = old[i - 1] + ndli_norm(ndli_sub(rod->x[i], rod->x[i - 1]));
    if (clamped)
        at[1] = old[1];
    for (int j = clamped; j < m - 1; j++)
        whole += reshape->length[j];
    scale = (old[n - 1] - at[clamped]) / whole;
    for (int i = clamped + 1; i < m - 1; i++)
        at[i] = at[i - 1] + scale * reshape->length[i - 1];
    at[m - 1] = old[n - 1];
}

/* rest_length from the cumulative one at the stations; linear: not by Akima. 0: some would be folded. */
static int ndli_rod_interpolate_lengths(const ndl_rod *rod, ndli_rod_reshape *reshape, int linear)
{
    ndli_rod_curve curve = reshape->curve;
    int cursor = 0, m = reshape->count;
    double before = 0;
    curve.at = reshape->old_at;
    curve.count = rod->node_count;
    curve.value[0] = 0;
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        curve.value[j + 1] = curve.value[j] + rod->rest_length[j];
    if (!linear)
        ndli_rod_set_slopes(&curve);
    for (int j = 0; j < m - 1; j++) {
        double u = reshape->at[j + 1], length, here = curve.value[curve.count - 1];
        if (linear && j < m - 2) {
            int i = ndli_rod_station(curve.at, curve.count, u, &cursor);
            here = curve.value[i] + (u - curve.at[i]) * ndli_rod_secant(&curve, i);
        } else if (j < m - 2) {
            here = ndli_rod_curve_at(&curve, u, 0, &cursor);
        }
        length = here - before;
        if (!linear && !(length > 0.2 * (u - reshape->at[j])))
            return 0;
        reshape->rest_length[j] = length;
        before = here;
    }
    return 1;
}

/* v and a, linear from node to node. */
static void ndli_rod_interpolate_motion(const ndl_rod *rod, ndli_rod_reshape *reshape)
{
    int cursor = 0, n = rod->node_count;
    for (int i = 0; i < reshape->count; i++) {
        int k = sbi_min_int(ndli_rod_station(reshape->old_at, n, reshape->at[i], &cursor), n - 2);
        double f = (reshape->at[i] - reshape->old_at[k]) / (reshape->old_at[k + 1] - reshape->old_at[k]);
        reshape->v[i] = ndli_add(ndli_scale(1 - f, rod->v[k]), ndli_scale(f, rod->v[k + 1]));
        reshape->a[i] = ndli_add(ndli_scale(1 - f, rod->a[k]), ndli_scale(f, rod->a[k + 1]));
    }
}

/* What a clamped base edge leaves of node 1's cell, once the rod has more than one inner node. */
static int ndli_rod_has_half_cell(const ndl_rod *rod, int nodes) { return nodes > 3 && rod->held[0] && rod->held[1]; }

/* Stations and curvature (1/m) at rest, towards m1 or m2, of the inner nodes from `first` on; they keep 2 tan of half
 * the turn. */
static void ndli_rod_set_curvature(const ndl_rod *rod, const ndli_rod_reshape *reshape, int first, int k,
                                   ndli_rod_curve *curve)
{
    curve->count = 0;
    for (int i = first; i < rod->node_count - 1; i++) {
        const double *bend = rod->rest_bend[i];
        double size = sqrt(bend[0] * bend[0] + bend[1] * bend[1]);
        double turn = size > 0 ? 2 * sbi_dense_atan2(0.5 * size, 1) / size : 1;
        curve->at[curve->count] = reshape->old_at[i];
        curve->value[curve->count++] = turn * bend[k] / rod->cell[i];
    }
    ndli_rod_set_slopes(curve);
}

static void ndli_rod_interpolate_component(const ndl_rod *rod, ndli_rod_reshape *reshape, int k)
{
    ndli_rod_curve curve = reshape->curve;
    int half = ndli_rod_has_half_cell(rod, rod->node_count), cursor = 0;
    double *curvature = reshape->curvature[k], kink = 0, cell = 0;
    ndli_rod_set_curvature(rod, reshape, 1, k, &curve);
    if (half) {
        kink = rod->cell[1] * (curve.value[0] - curve.value[1]);
        ndli_rod_set_curvature(rod, reshape, 2, k, &curve);
    }
    for (int i = 1; i < reshape->count - 1; i++)
        curvature[i] = curve.count < 1 ? 0 : ndli_rod_curve_at(&curve, reshape->at[i], 1, &cursor);
    if (half && reshape->count > 2) {
        cell = 0.5 * (reshape->rest_length[1] + (reshape->count > 3 ? 0 : reshape->rest_length[0]));
        curvature[1] += kink / cell;
    }
}

/* Curvature at rest of the inner nodes. In a clamp there is none: what turns node 1 beyond the curvature of the rod
 * that comes out there (as in a needle whose whole shape is its rest) is a kink, and stays as it is. -1, or the new
 * node that would turn the rod back. */
static int ndli_rod_interpolate_curvature(const ndl_rod *rod, ndli_rod_reshape *reshape)
{
    for (int k = 0; k < 2; k++)
        ndli_rod_interpolate_component(rod, reshape, k);
    for (int i = 1; i < reshape->count - 1; i++) {
        double k0 = reshape->curvature[0][i], k1 = reshape->curvature[1][i], cell = reshape->rest_length[i];
        if (i > 1 || !ndli_rod_has_half_cell(rod, reshape->count))
            cell += reshape->rest_length[i - 1];
        if (!(0.5 * sqrt(k0 * k0 + k1 * k1) * cell < 2.9))
            return i;
    }
    return -1;
}

/* Director and angle of the new edges. Angles are measured from a frame that parallel transport lays along the
 * polyline, and along another polyline it lies a little otherwise: material frames are kept, angles make up for it. */
static void ndli_rod_interpolate_frames(const ndl_rod *rod, ndli_rod_reshape *reshape)
{
    ndli_rod_curve curve = reshape->curve;
    int cursor = 0, edge = 0;
    curve.count = ndli_rod_edges(rod);
    for (int j = 0; j < curve.count; j++) {
        curve.at[j] = 0.5 * (reshape->old_at[j] + reshape->old_at[j + 1]);
        curve.value[j] = rod->theta[j];
    }
    ndli_rod_set_slopes(&curve);
    reshape->theta[0] = rod->theta[0];
    reshape->director[0] = ndli_rod_across(ndli_rod_transport(rod->tangent[0], reshape->tangent[0], rod->director[0]),
                                           reshape->tangent[0]);
    for (int j = 1; j < reshape->count - 1; j++) {
        ndli_v3 t = reshape->tangent[j], d, carried;
        double u = 0.5 * (reshape->at[j] + reshape->at[j + 1]);
        d = ndli_rod_across(ndli_rod_transport(reshape->tangent[j - 1], t, reshape->director[j - 1]), t);
        reshape->director[j] = d;
        reshape->theta[j] = ndli_rod_curve_at(&curve, u, 0, &cursor);
        edge = sbi_min_int(ndli_rod_station(reshape->old_at, rod->node_count, u, &edge), curve.count - 1);
        if (!ndli_rod_may_turn(rod->tangent[edge], t))
            continue;
        carried = ndli_rod_transport(rod->tangent[edge], t, rod->director[edge]);
        reshape->theta[j] += sbi_dense_atan2(ndli_dot(ndli_cross(d, carried), t), ndli_dot(d, carried));
    }
}

/* ---- the rod takes its new nodes ---- */

/* Supports and loads beyond the base edge are gone: their nodes are. */
static void ndli_rod_drop_supports(ndl_rod *rod)
{
    for (int i = 2; i < rod->node_count; i++) {
        rod->held[i] = rod->has_velocity[i] = 0;
        rod->force[i] = rod->reaction[i] = ndli_v(0, 0, 0);
    }
    for (int j = 1; j < rod->node_count - 1; j++) {
        rod->turn_held[j] = 0;
        rod->turn[j] = rod->torque[j] = rod->reaction_torque[j] = 0;
    }
}

static ndli_v3 ndli_rod_momentum(const ndl_rod *rod)
{
    ndli_v3 sum = ndli_v(0, 0, 0);
    for (int i = 0; i < rod->node_count; i++)
        sum = ndli_madd(sum, rod->mass[i], rod->v[i]);
    return sum;
}

/* Free nodes get what is missing of the momentum, all the same velocity. */
static void ndli_rod_restore_momentum(ndl_rod *rod, ndli_v3 momentum)
{
    ndli_v3 missing = ndli_sub(momentum, ndli_rod_momentum(rod));
    double mass = 0;
    for (int i = 0; i < rod->node_count; i++)
        mass += rod->held[i] ? 0 : rod->mass[i];
    for (int i = 0; i < rod->node_count && mass > 0; i++)
        if (!rod->held[i])
            rod->v[i] = ndli_madd(rod->v[i], 1 / mass, missing);
}

static void ndli_rod_take_reshape(ndl_rod *rod, const ndli_rod_reshape *reshape)
{
    size_t nodes = (size_t)reshape->count, edges = nodes - 1;
    ndli_v3 momentum = ndli_rod_momentum(rod);
    rod->node_count = reshape->count;
    memmove(rod->x, reshape->x, nodes * sizeof *rod->x);
    memcpy(rod->v, reshape->v, nodes * sizeof *rod->v);
    memcpy(rod->a, reshape->a, nodes * sizeof *rod->a);
    memcpy(rod->tangent, reshape->tangent, edges * sizeof *rod->tangent);
    memcpy(rod->director, reshape->director, edges * sizeof *rod->director);
    memcpy(rod->theta, reshape->theta, edges * sizeof *rod->theta);
    memcpy(rod->grip, reshape->grip.grip, edges * sizeof *rod->grip);
    memcpy(rod->grip_limit, reshape->grip.limit, edges * sizeof *rod->grip_limit);
    rod->grips = 0;
    for (size_t j = 0; j < edges; j++) {
        rod->anchor[j] = rod->theta[j] - reshape->grip.lag[j];
        rod->grips += rod->grip[j] > 0;
    }
    memcpy(rod->rest_length, reshape->rest_length, edges * sizeof *rod->rest_length);
    ndli_rod_drop_supports(rod);
    ndli_rod_rest_changed(rod);
    ndli_rod_restore_momentum(rod, momentum);
    memset(rod->rest_bend, 0, nodes * sizeof *rod->rest_bend);
    for (int i = 1; i < rod->node_count - 1; i++)
        ndli_rod_bend_to(rod, i, reshape->curvature[0][i], reshape->curvature[1][i]);
}

NDLI_API int ndli_rod_reparameterise(ndl_rod *rod, const ndli_v3 *positions, int count)
{
    ndli_rod_reshape reshape = ndli_rod_begin_reshape(rod, positions, count);
    int bad = ndli_rod_check_nodes(rod, &reshape);
    if (bad >= 0)
        return bad;
    ndli_rod_set_stations(rod, &reshape);
    if (!ndli_rod_interpolate_lengths(rod, &reshape, 0))
        ndli_rod_interpolate_lengths(rod, &reshape, 1);
    for (int j = 0; j < count - 1; j++) /* what ndli_rod_set_shape asks for */
        if (!(reshape.length[j] > 1e-3 * reshape.rest_length[j]) || !(reshape.rest_length[j] > 0))
            return j + 1;
    bad = ndli_rod_interpolate_curvature(rod, &reshape);
    if (bad >= 0)
        return bad;
    ndli_rod_interpolate_motion(rod, &reshape);
    ndli_rod_interpolate_frames(rod, &reshape);
    ndli_rod_spread_grip(rod, reshape.old_at, reshape.at, count, &reshape.grip);
    ndli_rod_take_reshape(rod, &reshape);
    rod->energy_monitored = 0;
    ndli_rod_relax(rod);
    ndli_rod_slip(rod);
    return -1;
}

NDL_API sb_result ndl_rod_reparameterise(ndl_rod *rod, const sb_vec3 *positions, int count, sb_error *error)
{
    int bad;
    if (!rod || !positions || count < 2)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "rod or positions is NULL, or count is below 2");
    if (count > rod->capacity)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "%d nodes are more than the capacity %d", count, rod->capacity);
    for (int i = 0; i < count; i++) {
        if (!sb_v3_is_finite(positions[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "node %d is not finite", i);
        rod->try_x[i] = ndli_from(positions[i]);
    }
    bad = ndli_rod_reparameterise(rod, rod->try_x, count);
    if (bad >= 0)
        return sbi_fail_node(error, SB_ERROR_MESH, bad, "the rod has no length or turns back at node %d", bad);
    ndli_rod_publish(rod);
    return SB_OK;
}
