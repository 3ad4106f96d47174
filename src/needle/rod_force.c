/* rod_force: energies of a rod and their derivatives. Formulas: Bergou et al. 2008 and 2010, with the exact gradient of
 * the curvature binormal (edges may change length), and their second derivatives.
 *
 * With a = t_i-1, b = t_i, chi = 1 + a.b, tt = (a + b)/chi and the binormal kb = 2 a x b/chi:
 *     D0 = d kb/d e_i-1 = (-kb tt^T - (2/chi) [b])/l_i-1,   D1 = d kb/d e_i = (-kb tt^T + (2/chi) [a])/l_i
 * and in the frame of edge j the curvature is w_j = (kb.m2_j, -kb.m1_j). kb is at right angles to both edges, so that
 * the turning of the frames with their edges drops out of the first derivatives of w. */
#include "rod_private.h"

/* Beyond this turn from edge to edge (2.94 rad) a rod counts as folded: its curvature grows without bound. */
static const double ndli_rod_least_chi = 0.02;

NDLI_API ndli_v3 ndli_rod_transport(ndli_v3 p, ndli_v3 q, ndli_v3 v)
{
    ndli_v3 b = ndli_cross(p, q);
    double c = ndli_dot(p, q);
    return ndli_madd(ndli_madd(ndli_cross(b, v), c, v), ndli_dot(b, v) / (1 + c), b);
}

NDLI_API int ndli_rod_may_turn(ndli_v3 p, ndli_v3 q) { return 1 + ndli_dot(p, q) > ndli_rod_least_chi; }

NDLI_API ndli_v3 ndli_rod_across(ndli_v3 v, ndli_v3 t)
{
    double size = ndli_norm(v), left;
    ndli_v3 across = ndli_madd(v, -ndli_dot(v, t), t);
    left = ndli_norm(across);
    if (!(left > 1e-6 * size)) {
        across = ndli_cross(t, fabs(t.x) < 0.6 ? ndli_v(1, 0, 0) : ndli_v(0, 1, 0));
        left = ndli_norm(across);
    }
    across = ndli_scale(1 / left, across);
    across = ndli_madd(across, -ndli_dot(across, t), t);
    return ndli_scale(1 / ndli_norm(across), across);
}

/* ---- shape ---- */

static void ndli_rod_set_frame(const ndl_rod *rod, int j, const double *theta)
{
    const ndli_rod_shape *shape = &rod->shape;
    ndli_v3 d = shape->director[j], across = ndli_cross(shape->tangent[j], d);
    double s, c;
    sbi_dense_sin_cos(theta[j], &s, &c);
    shape->lag[j] = theta[j] - rod->anchor[j];
    shape->m1[j] = ndli_madd(ndli_scale(c, d), s, across);
    shape->m2[j] = ndli_madd(ndli_scale(-s, d), c, across);
}

static int ndli_rod_set_edge(const ndl_rod *rod, int j, const ndli_v3 *x, const double *theta)
{
    const ndli_rod_shape *shape = &rod->shape;
    ndli_v3 e = ndli_sub(x[j + 1], x[j]);
    double length = ndli_norm(e);
    if (!(length > 1e-3 * rod->rest_length[j]) || !ndli_is_finite(length))
        return 0;
    shape->length[j] = length;
    shape->tangent[j] = ndli_scale(1 / length, e);
    if (!(1 + ndli_dot(rod->tangent[j], shape->tangent[j]) > ndli_rod_least_chi))
        return 0;
    shape->director[j] = ndli_rod_transport(rod->tangent[j], shape->tangent[j], rod->director[j]);
    ndli_rod_set_frame(rod, j, theta);
    return 1;
}

static int ndli_rod_set_bend(const ndl_rod *rod, int i, const double *theta)
{
    const ndli_rod_shape *shape = &rod->shape;
    ndli_v3 a = shape->tangent[i - 1], b = shape->tangent[i], carried;
    double chi = 1 + ndli_dot(a, b);
    if (!(chi > ndli_rod_least_chi))
        return 0;
    shape->chi[i] = chi;
    shape->binormal[i] = ndli_scale(2 / chi, ndli_cross(a, b));
    carried = ndli_rod_transport(a, b, shape->director[i - 1]);
    shape->reference[i] =
        sbi_dense_atan2(ndli_dot(ndli_cross(carried, shape->director[i]), b), ndli_dot(carried, shape->director[i]));
    shape->twist[i] = theta[i] - theta[i - 1] + shape->reference[i];
    return 1;
}

NDLI_API int ndli_rod_set_shape(const ndl_rod *rod, const ndli_v3 *x, const double *theta)
{
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        if (!ndli_rod_set_edge(rod, j, x, theta))
            return j + 1;
    for (int i = 1; i < rod->node_count - 1; i++)
        if (!ndli_rod_set_bend(rod, i, theta))
            return i;
    return -1;
}

NDLI_API void ndli_rod_set_angles(const ndl_rod *rod, const double *theta, int frames)
{
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        if (frames)
            ndli_rod_set_frame(rod, j, theta);
        else
            rod->shape.lag[j] = theta[j] - rod->anchor[j];
    }
    for (int i = 1; i < rod->node_count - 1; i++)
        rod->shape.twist[i] = theta[i] - theta[i - 1] + rod->shape.reference[i];
}

/* ---- energy ---- */

NDLI_API double ndli_rod_reach(const ndl_rod *rod)
{
    double reach = 0;
    for (int i = 0; i < rod->node_count; i++)
        for (int k = 0; k < 3; k++)
            reach = fmax(reach, fabs(ndli_component(rod->x[i], k)));
    return reach;
}

/* Curvature of node i in the frame of edge j. */
static void ndli_rod_material_curvature(const ndl_rod *rod, int i, int j, double w[2])
{
    w[0] = ndli_dot(rod->shape.binormal[i], rod->shape.m2[j]);
    w[1] = -ndli_dot(rod->shape.binormal[i], rod->shape.m1[j]);
}

static void ndli_rod_add_bend_energy(const ndl_rod *rod, int i, ndli_rod_sums *sums)
{
    double w[2];
    if (rod->plain) {
        ndli_v3 kb = rod->shape.binormal[i], change = ndli_sub(kb, rod->old_binormal[i]);
        double k = 0.5 * rod->bending[0] / rod->cell[i];
        sums->bend += k * ndli_dot(kb, kb);
        if (rod->viscous_bend > 0)
            sums->viscous += k * rod->viscous_bend * ndli_dot(change, change);
        return;
    }
    for (int f = 0; f < 2; f++) {
        ndli_rod_material_curvature(rod, i, i - 1 + f, w);
        for (int c = 0; c < 2; c++) {
            double k = 0.25 * rod->bending[c] / rod->cell[i], bent = w[c] - rod->rest_bend[i][c];
            double change = w[c] - rod->old_bend[i][2 * f + c];
            sums->bend += k * bent * bent;
            if (rod->viscous_bend > 0)
                sums->viscous += k * rod->viscous_bend * change * change;
        }
    }
}

NDLI_API ndli_rod_sums ndli_rod_shape_energy(const ndl_rod *rod)
{
    ndli_rod_sums sums = {0, 0, 0, 0, 0, 0, 0};
    double reach = ndli_rod_reach(rod);
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        double strain = rod->shape.length[j] / rod->rest_length[j] - 1, unknown = 2.3e-16 * reach / rod->rest_length[j];
        sums.stretch += 0.5 * rod->stretch * rod->rest_length[j] * strain * strain;
        if (rod->viscous_stretch > 0) {
            double change = (rod->shape.length[j] - rod->old_length[j]) / rod->rest_length[j];
            sums.viscous += 0.5 * rod->viscous_stretch * rod->stretch * rod->rest_length[j] * change * change;
            sums.noise +=
                rod->viscous_stretch * rod->stretch * rod->rest_length[j] * (fabs(change) + unknown) * unknown;
        }
        sums.noise += rod->stretch * rod->rest_length[j] * (fabs(strain) + unknown) * unknown;
    }
    for (int i = 1; i < rod->node_count - 1; i++) {
        ndli_rod_add_bend_energy(rod, i, &sums);
        sums.twist += 0.5 * rod->torsion / rod->cell[i] * rod->shape.twist[i] * rod->shape.twist[i];
    }
    if (rod->grips > 0)
        ndli_rod_add_grip_energy(rod, &sums);
    sums.noise += sums.turn_noise + 4.5e-15 * (sums.stretch + sums.bend + sums.twist + sums.grip + sums.viscous);
    return sums;
}

/* ---- derivatives ---- */

/* First and second derivatives of the energy at one node in e_i-1, e_i (0, 1) and theta_i-1, theta_i (0, 1). */
typedef struct ndli_rod_local {
    ndli_v3 edge[2];
    double turn[2];
    ndli_m3 edges[2][2]; /* [1][0] is the transpose of [0][1] and not kept */
    ndli_v3 cross[2][2]; /* [edge][theta] */
    double turns[2], turns_between;
} ndli_rod_local;

/* What the curvature of node i depends on. */
typedef struct ndli_rod_bend {
    ndli_v3 a, b, tt, kb;
    double l[2], chi;
    ndli_m3 d[2]; /* D0, D1 */
} ndli_rod_bend;

static ndli_rod_bend ndli_rod_get_bend(const ndl_rod *rod, int i)
{
    const ndli_rod_shape *shape = &rod->shape;
    ndli_rod_bend bend;
    bend.a = shape->tangent[i - 1];
    bend.b = shape->tangent[i];
    bend.kb = shape->binormal[i];
    bend.chi = shape->chi[i];
    bend.l[0] = shape->length[i - 1];
    bend.l[1] = shape->length[i];
    bend.tt = ndli_scale(1 / bend.chi, ndli_add(bend.a, bend.b));
    for (int k = 0; k < 2; k++) {
        bend.d[k] = ndli_m_zero();
        ndli_m_add_outer(&bend.d[k], -1 / bend.l[k], bend.kb, bend.tt);
    }
    ndli_m_add_cross(&bend.d[0], -2 / (bend.chi * bend.l[0]), bend.b);
    ndli_m_add_cross(&bend.d[1], 2 / (bend.chi * bend.l[1]), bend.a);
    return bend;
}

/* edges[][] += D^T q D */
static void ndli_rod_add_gauss_newton(const ndli_rod_bend *bend, const ndli_m3 *q, ndli_rod_local *local)
{
    for (int k = 0; k < 2; k++) {
        ndli_m3 qd = ndli_m_mul(q, &bend->d[k]);
        for (int r = 0; r <= k; r++) {
            ndli_m3 product = ndli_m_tmul(&bend->d[r], &qd);
            ndli_m_add(&local->edges[r][k], 1, &product);
        }
    }
}

/* *a += s (u v^T + v u^T) */
static void ndli_rod_add_symmetric(ndli_m3 *a, double s, ndli_v3 u, ndli_v3 v)
{
    ndli_m_add_outer(a, s, u, v);
    ndli_m_add_outer(a, s, v, u);
}

/* edges[][] += second derivative of p.kb for a constant p; g_k = D_k^T p:
 *     00: -(g0 tt^T + tt g0^T)/l0 - (p.kb) (I - a a^T)/(chi l0^2), 11 with b, g1, l1
 *     01: (-tt g1^T - ((p.kb) (I - b b^T) + 2 [p] (I - b b^T))/(chi l1) - (l0/l1) g0 (tt - b)^T)/l0 */
static void ndli_rod_add_curvature_hessian(const ndli_rod_bend *bend, ndli_v3 p, ndli_rod_local *local)
{
    double along = ndli_dot(p, bend->kb), l0 = bend->l[0], l1 = bend->l[1];
    ndli_v3 g[2], t[2];
    ndli_m3 *mixed = &local->edges[0][1];
    t[0] = bend->a;
    t[1] = bend->b;
    for (int k = 0; k < 2; k++) {
        double s = along / (bend->chi * bend->l[k] * bend->l[k]);
        g[k] = ndli_m_tapply(&bend->d[k], p);
        ndli_rod_add_symmetric(&local->edges[k][k], -1 / bend->l[k], g[k], bend->tt);
        ndli_m_add_identity(&local->edges[k][k], -s);
        ndli_m_add_outer(&local->edges[k][k], s, t[k], t[k]);
    }
    ndli_m_add_outer(mixed, -1 / l0, bend->tt, g[1]);
    ndli_m_add_identity(mixed, -along / (bend->chi * l0 * l1));
    ndli_m_add_outer(mixed, along / (bend->chi * l0 * l1), bend->b, bend->b);
    ndli_m_add_cross(mixed, -2 / (bend->chi * l0 * l1), p);
    ndli_m_add_outer(mixed, 2 / (bend->chi * l0 * l1), ndli_cross(p, bend->b), bend->b);
    ndli_m_add_outer(mixed, -1 / l1, g[0], ndli_sub(bend->tt, bend->b));
}

static void ndli_rod_plain_bend(const ndl_rod *rod, int i, int flags, const ndli_rod_bend *bend, int wanted,
                                ndli_rod_local *local)
{
    double k = rod->bending[0] / rod->cell[i];
    ndli_v3 p = ndli_scale(k, bend->kb);
    ndli_m3 q = ndli_m_zero();
    if (rod->viscous_bend > 0) {
        p = ndli_madd(p, k * rod->viscous_bend, ndli_sub(bend->kb, rod->old_binormal[i]));
        k *= 1 + rod->viscous_bend;
    }
    for (int e = 0; e < 2; e++)
        local->edge[e] = ndli_m_tapply(&bend->d[e], p);
    if (!wanted)
        return;
    ndli_m_add_identity(&q, k);
    ndli_rod_add_gauss_newton(bend, &q, local);
    if (flags & NDLI_ROD_EXACT)
        ndli_rod_add_curvature_hessian(bend, p, local);
}

/* Curvature w of node i in the frame of edge i - 1 + f, moment s against it and its stiffness, damping included. */
static void ndli_rod_frame_moment(const ndl_rod *rod, int i, int f, double w[2], double s[2], double stiff[2])
{
    ndli_rod_material_curvature(rod, i, i - 1 + f, w);
    for (int k = 0; k < 2; k++) {
        stiff[k] = rod->bending[k] / (2 * rod->cell[i]);
        s[k] = stiff[k] * (w[k] - rod->rest_bend[i][k]);
        if (rod->viscous_bend > 0) {
            s[k] += stiff[k] * rod->viscous_bend * (w[k] - rod->old_bend[i][2 * f + k]);
            stiff[k] *= 1 + rod->viscous_bend;
        }
    }
}

/* Bending seen from the frame of edge i - 1 + f. Exact second derivatives have two more terms: of the frame's turning
 * with its edge, (kb p^T + p kb^T)/(2 l^2), and of the curvature in the angle. */
static void ndli_rod_frame_bend(const ndl_rod *rod, int i, int f, int flags, const ndli_rod_bend *bend, int wanted,
                                ndli_rod_local *local)
{
    int j = i - 1 + f;
    ndli_v3 m1 = rod->shape.m1[j], m2 = rod->shape.m2[j], p, mixed;
    double w[2], s[2], stiff[2];
    ndli_m3 q = ndli_m_zero();
    ndli_rod_frame_moment(rod, i, f, w, s, stiff);
    p = ndli_madd(ndli_scale(s[0], m2), -s[1], m1);
    for (int e = 0; e < 2; e++)
        local->edge[e] = ndli_add(local->edge[e], ndli_m_tapply(&bend->d[e], p));
    local->turn[f] += s[0] * w[1] - s[1] * w[0];
    if (!wanted)
        return;
    ndli_m_add_outer(&q, stiff[0], m2, m2);
    ndli_m_add_outer(&q, stiff[1], m1, m1);
    ndli_rod_add_gauss_newton(bend, &q, local);
    mixed = ndli_madd(ndli_scale(stiff[0] * w[1], m2), stiff[1] * w[0], m1);
    local->turns[f] += stiff[0] * w[1] * w[1] + stiff[1] * w[0] * w[0];
    if (flags & NDLI_ROD_EXACT) {
        ndli_rod_add_curvature_hessian(bend, p, local);
        ndli_rod_add_symmetric(&local->edges[f][f], 0.5 / (bend->l[f] * bend->l[f]), bend->kb, p);
        mixed = ndli_madd(ndli_madd(mixed, -s[0], m1), -s[1], m2);
        local->turns[f] -= s[0] * w[0] + s[1] * w[1];
    }
    for (int e = 0; e < 2; e++)
        local->cross[e][f] = ndli_add(local->cross[e][f], ndli_m_tapply(&bend->d[e], mixed));
}

/* d m/d e = kb/(2 l) on both edges; second derivatives (symmetric parts: the rest is holonomy)
 *     00: -(kb (a + tt)^T + (a + tt) kb^T)/(4 l0^2), 11 with b, l1;   01: D1/(2 l0) */
static void ndli_rod_twist_local(const ndl_rod *rod, int i, int flags, const ndli_rod_bend *bend, int wanted,
                                 ndli_rod_local *local)
{
    double k = rod->torsion / rod->cell[i], moment = k * rod->shape.twist[i];
    ndli_v3 g[2];
    for (int e = 0; e < 2; e++) {
        g[e] = ndli_scale(0.5 / bend->l[e], bend->kb);
        local->edge[e] = ndli_madd(local->edge[e], moment, g[e]);
    }
    local->turn[0] -= moment;
    local->turn[1] += moment;
    if (!wanted || (flags & NDLI_ROD_NO_TWIST))
        return;
    for (int e = 0; e < 2; e++) {
        ndli_m_add_outer(&local->edges[e][e], k, g[e], g[e]);
        local->cross[e][0] = ndli_madd(local->cross[e][0], -k, g[e]);
        local->cross[e][1] = ndli_madd(local->cross[e][1], k, g[e]);
        local->turns[e] += k;
    }
    ndli_m_add_outer(&local->edges[0][1], k, g[0], g[1]);
    local->turns_between -= k;
    if (!(flags & NDLI_ROD_EXACT))
        return;
    for (int e = 0; e < 2; e++)
        ndli_rod_add_symmetric(&local->edges[e][e], -0.25 * moment / (bend->l[e] * bend->l[e]), bend->kb,
                               ndli_add(e ? bend->b : bend->a, bend->tt));
    ndli_m_add(&local->edges[0][1], 0.5 * moment / bend->l[0], &bend->d[1]);
}

/* Edge derivatives to nodes: e_i-1 = x_i - x_i-1, e_i = x_i+1 - x_i. */
static void ndli_rod_scatter(const ndli_rod_local *local, int i, ndli_v3 *gradient, double *turn_gradient,
                             ndli_rod_matrix *matrix)
{
    const ndli_m3 *h00 = &local->edges[0][0], *h01 = &local->edges[0][1], *h11 = &local->edges[1][1];
    ndli_m3 h10 = ndli_m_transpose(h01);
    gradient[i - 1] = ndli_sub(gradient[i - 1], local->edge[0]);
    gradient[i] = ndli_add(gradient[i], ndli_sub(local->edge[0], local->edge[1]));
    gradient[i + 1] = ndli_add(gradient[i + 1], local->edge[1]);
    turn_gradient[i - 1] += local->turn[0];
    turn_gradient[i] += local->turn[1];
    if (!matrix)
        return;
    ndli_m_add(&matrix->node[i - 1][0], 1, h00);
    ndli_m_add(&matrix->node[i][0], 1, h00);
    ndli_m_add(&matrix->node[i][0], -1, h01);
    ndli_m_add(&matrix->node[i][0], -1, &h10);
    ndli_m_add(&matrix->node[i][0], 1, h11);
    ndli_m_add(&matrix->node[i + 1][0], 1, h11);
    ndli_m_add(&matrix->node[i][1], -1, h00);
    ndli_m_add(&matrix->node[i][1], 1, &h10);
    ndli_m_add(&matrix->node[i + 1][1], 1, &h10);
    ndli_m_add(&matrix->node[i + 1][1], -1, h11);
    ndli_m_add(&matrix->node[i + 1][2], -1, &h10);
    for (int f = 0; f < 2; f++) {
        int j = i - 1 + f;
        ndli_v3 *cross = matrix->cross[j] + (f ? 0 : 1);
        cross[0] = ndli_sub(cross[0], local->cross[0][f]);
        cross[1] = ndli_add(cross[1], ndli_sub(local->cross[0][f], local->cross[1][f]));
        cross[2] = ndli_add(cross[2], local->cross[1][f]);
        matrix->turn[j] += local->turns[f];
    }
    matrix->turn_before[i] += local->turns_between;
}

static void ndli_rod_stretch(const ndl_rod *rod, int j, int flags, ndli_v3 *gradient, ndli_rod_matrix *matrix)
{
    ndli_v3 t = rod->shape.tangent[j];
    double rest = rod->rest_length[j], l = rod->shape.length[j], tension = rod->stretch * (l / rest - 1), across;
    double stiff = rod->stretch / rest;
    ndli_v3 g;
    ndli_m3 h = ndli_m_zero();
    if (rod->viscous_stretch > 0) {
        tension += rod->viscous_stretch * stiff * (l - rod->old_length[j]);
        stiff *= 1 + rod->viscous_stretch;
    }
    across = tension / l;
    g = ndli_scale(tension, t);
    gradient[j] = ndli_sub(gradient[j], g);
    gradient[j + 1] = ndli_add(gradient[j + 1], g);
    if (!matrix)
        return;
    if (!(flags & NDLI_ROD_EXACT) && across < 0)
        across = 0;
    ndli_m_add_identity(&h, across);
    ndli_m_add_outer(&h, stiff - across, t, t);
    ndli_m_add(&matrix->node[j][0], 1, &h);
    ndli_m_add(&matrix->node[j + 1][0], 1, &h);
    ndli_m_add(&matrix->node[j + 1][1], -1, &h);
}

NDLI_API void ndli_rod_derivatives(const ndl_rod *rod, int flags, ndli_v3 *gradient, double *turn_gradient,
                                   ndli_rod_matrix *matrix)
{
    size_t nodes = (size_t)rod->node_count;
    memset(gradient, 0, nodes * sizeof *gradient);
    memset(turn_gradient, 0, nodes * sizeof *turn_gradient);
    if (matrix) {
        memset(matrix->node, 0, nodes * sizeof *matrix->node);
        memset(matrix->cross, 0, nodes * sizeof *matrix->cross);
        memset(matrix->turn, 0, nodes * sizeof *matrix->turn);
        memset(matrix->turn_before, 0, nodes * sizeof *matrix->turn_before);
    }
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        ndli_rod_stretch(rod, j, flags, gradient, matrix);
    for (int i = 1; i < rod->node_count - 1; i++) {
        ndli_rod_bend bend = ndli_rod_get_bend(rod, i);
        ndli_rod_local local;
        memset(&local, 0, sizeof local);
        if (rod->plain)
            ndli_rod_plain_bend(rod, i, flags, &bend, matrix != NULL, &local);
        else
            for (int f = 0; f < 2; f++)
                ndli_rod_frame_bend(rod, i, f, flags, &bend, matrix != NULL, &local);
        ndli_rod_twist_local(rod, i, flags, &bend, matrix != NULL, &local);
        ndli_rod_scatter(&local, i, gradient, turn_gradient, matrix);
    }
    if (rod->grips > 0)
        ndli_rod_add_grip_derivatives(rod, turn_gradient, matrix);
}

NDLI_API void ndli_rod_turn_derivatives(const ndl_rod *rod, int flags, double *turn_gradient, ndli_rod_matrix *matrix)
{
    size_t bytes = (size_t)rod->node_count * sizeof(double);
    memset(turn_gradient, 0, bytes);
    memset(matrix->turn, 0, bytes);
    memset(matrix->turn_before, 0, bytes);
    for (int i = 1; i < rod->node_count - 1; i++) {
        double k = rod->torsion / rod->cell[i], moment = k * rod->shape.twist[i];
        for (int f = 0; f < 2; f++) {
            double gradient = 0, turns = 0, w[2], s[2], stiff[2];
            if (!rod->plain) {
                ndli_rod_frame_moment(rod, i, f, w, s, stiff);
                gradient = s[0] * w[1] - s[1] * w[0];
                turns = stiff[0] * w[1] * w[1] + stiff[1] * w[0] * w[0];
                if (flags & NDLI_ROD_EXACT)
                    turns -= s[0] * w[0] + s[1] * w[1];
            }
            turn_gradient[i - 1 + f] += gradient + (f ? moment : -moment);
            matrix->turn[i - 1 + f] += turns + k;
        }
        matrix->turn_before[i] -= k;
    }
    if (rod->grips > 0)
        ndli_rod_add_grip_derivatives(rod, turn_gradient, matrix);
}

/* ---- damping within a step ---- */

NDLI_API void ndli_rod_set_viscous(ndl_rod *rod, double stretch, double bend, double ahead)
{
    rod->viscous_stretch = stretch;
    rod->viscous_bend = bend;
    if (!(stretch > 0) && !(bend > 0))
        return;
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        double rate = ndli_dot(rod->shape.tangent[j], ndli_sub(rod->v[j + 1], rod->v[j]));
        rod->old_length[j] = rod->shape.length[j] + ahead * rate;
    }
    for (int i = 1; i < rod->node_count - 1; i++) {
        ndli_rod_bend at = ndli_rod_get_bend(rod, i);
        ndli_v3 rate = ndli_add(ndli_m_apply(&at.d[0], ndli_sub(rod->v[i], rod->v[i - 1])),
                                ndli_m_apply(&at.d[1], ndli_sub(rod->v[i + 1], rod->v[i])));
        ndli_v3 kb = ndli_madd(at.kb, ahead, rate);
        rod->old_binormal[i] = kb;
        for (int f = 0; f < 2; f++) {
            rod->old_bend[i][2 * f] = ndli_dot(kb, rod->shape.m2[i - 1 + f]);
            rod->old_bend[i][2 * f + 1] = -ndli_dot(kb, rod->shape.m1[i - 1 + f]);
        }
    }
}

/* ---- damping ----
 * Stretching: D = 1/2 sum (K_d/lb)(t.dv)^2 with K_d = damping_stretch K_s; bending: C = damping_bending times the
 * Gauss-Newton matrix of bending. */

NDLI_API void ndli_rod_set_damping_shape(ndl_rod *rod)
{
    memcpy(rod->damping_tangent, rod->shape.tangent, (size_t)ndli_rod_edges(rod) * sizeof *rod->damping_tangent);
    for (int i = 1; i < rod->node_count - 1; i++) {
        ndli_rod_bend bend = ndli_rod_get_bend(rod, i);
        double scale = rod->damping_bending / rod->cell[i];
        ndli_m3 *q = &rod->damping_weight[i];
        rod->damping_before[i] = bend.d[0];
        rod->damping_after[i] = bend.d[1];
        *q = ndli_m_zero();
        if (rod->plain)
            ndli_m_add_identity(q, scale * rod->bending[0]);
        else
            for (int j = i - 1; j <= i; j++) {
                ndli_m_add_outer(q, 0.5 * scale * rod->bending[0], rod->shape.m2[j], rod->shape.m2[j]);
                ndli_m_add_outer(q, 0.5 * scale * rod->bending[1], rod->shape.m1[j], rod->shape.m1[j]);
            }
    }
}

NDLI_API double ndli_rod_add_damping_force(const ndl_rod *rod, const ndli_v3 *v, ndli_v3 *gradient)
{
    double power = 0;
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        ndli_v3 t = rod->damping_tangent[j];
        double rate = ndli_dot(t, ndli_sub(v[j + 1], v[j]));
        ndli_v3 g = ndli_scale(rod->damping_stretch * rod->stretch / rod->rest_length[j] * rate, t);
        power += rod->damping_stretch * rod->stretch / rod->rest_length[j] * rate * rate;
        gradient[j] = ndli_sub(gradient[j], g);
        gradient[j + 1] = ndli_add(gradient[j + 1], g);
    }
    for (int i = 1; i < rod->node_count - 1; i++) {
        ndli_v3 rate = ndli_add(ndli_m_apply(&rod->damping_before[i], ndli_sub(v[i], v[i - 1])),
                                ndli_m_apply(&rod->damping_after[i], ndli_sub(v[i + 1], v[i])));
        ndli_v3 p = ndli_m_apply(&rod->damping_weight[i], rate);
        ndli_v3 g0 = ndli_m_tapply(&rod->damping_before[i], p), g1 = ndli_m_tapply(&rod->damping_after[i], p);
        power += ndli_dot(p, rate);
        gradient[i - 1] = ndli_sub(gradient[i - 1], g0);
        gradient[i] = ndli_add(gradient[i], ndli_sub(g0, g1));
        gradient[i + 1] = ndli_add(gradient[i + 1], g1);
    }
    return power;
}

NDLI_API void ndli_rod_add_damping_matrix(const ndl_rod *rod, double factor, ndli_rod_matrix *matrix)
{
    int bends = rod->damping_bending > 0 ? rod->node_count - 1 : 0;
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        double k = factor * rod->damping_stretch * rod->stretch / rod->rest_length[j];
        ndli_v3 t = rod->damping_tangent[j];
        ndli_m_add_outer(&matrix->node[j][0], k, t, t);
        ndli_m_add_outer(&matrix->node[j + 1][0], k, t, t);
        ndli_m_add_outer(&matrix->node[j + 1][1], -k, t, t);
    }
    for (int i = 1; i < bends; i++) {
        ndli_m3 j[3]; /* d kb/d x_i-1, x_i, x_i+1 */
        j[0] = j[1] = j[2] = ndli_m_zero();
        ndli_m_add(&j[0], -1, &rod->damping_before[i]);
        ndli_m_add(&j[1], 1, &rod->damping_before[i]);
        ndli_m_add(&j[1], -1, &rod->damping_after[i]);
        ndli_m_add(&j[2], 1, &rod->damping_after[i]);
        for (int r = 0; r < 3; r++)
            for (int c = 0; c <= r; c++) {
                ndli_m3 right = ndli_m_mul(&rod->damping_weight[i], &j[c]), block = ndli_m_tmul(&j[r], &right);
                ndli_m_add(&matrix->node[i - 1 + r][r - c], factor, &block);
            }
    }
}
