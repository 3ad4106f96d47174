/* assembly_turn: the rotation that all points of a corotated cell share, and what comes with it. */
#include "assembly.h"

SBI_API sb_mat3 sbi_assembly_mean_gradient(const sb_mat3 *f, const sb_real *weights, int q)
{
    sb_mat3 sum = sb_m3_zero();
    sb_real volume = 0;
    for (int p = 0; p < q; p++) {
        volume += weights[p];
        sum = sb_m3_add(sum, sb_m3_scale(weights[p], f[p]));
    }
    return volume > 0 ? sb_m3_scale(1 / volume, sum) : sb_m3_identity();
}

/* The rotation R of the mean gradient f = V R makes no energy of the points least, as that of an ordinary point does,
 * so that W depends on u through it, too. dW = m . w for dR = [w]x R with the axial vector m of the sum of w P F^T, and
 * df = [w]x f + dV R gives (tr(V) I - V) w = axial(df R^T - R df^T); hence dW = ([n]x R) : df with
 * (tr(V) I - V) n = m. The eigenvalues of that matrix are sums of two principal stretches, 2 at rest; where they come
 * near 0 the cell is about to be inside out and R to jump. There, and where the points have turned so far against each
 * other that n exceeds a fifth of stiffness, the stress fades: tangents that keep R do not know it, and linearised
 * steps of violent motion would not be stable. */
SBI_API sb_mat3 sbi_assembly_turning_stress(sb_mat3 r, sb_mat3 f, sb_vec3 moment, sb_real stiffness)
{
    const sb_real least = (sb_real)0.1, most = (sb_real)0.2; /* product of the eigenvalues; |n|/stiffness */
    sb_mat3 v = sb_m3_mult(f, r), g, cofactor, n = sb_m3_zero();
    sb_real trace = sb_m3_trace(v), det, excess;
    sb_vec3 turn;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            g.m[i][j] = (i == j ? trace : (sb_real)0) - (sb_real)0.5 * (v.m[i][j] + v.m[j][i]);
    cofactor = sb_m3_cofactor(g);
    det = sb_v3_dot(sb_m3_column(g, 0), sb_m3_column(cofactor, 0));
    turn = sb_v3_scale(1 / (stiffness * sb_max(det, least)), sb_m3_apply(cofactor, moment));
    excess = sb_max(sb_v3_dot(turn, turn) / (most * most), 1);
    turn = sb_v3_scale(stiffness / (excess * excess), turn);
    n.m[0][1] = -turn.z, n.m[1][0] = turn.z;
    n.m[2][0] = -turn.y, n.m[0][2] = turn.y;
    n.m[1][2] = -turn.x, n.m[2][1] = turn.x;
    return sb_m3_mul(n, r);
}

/* 1 when the rotations of a cell's points differ by more than 120 degrees somewhere. */
static int sbi_cell_is_twisted(const sb_quat *rotation, int q)
{
    const sb_real cos_half_angle = (sb_real)0.5;
    for (int i = 1; i < q; i++)
        for (int j = 0; j < i; j++)
            if (sb_abs(sb_quat_dot(rotation[i], rotation[j])) < cos_half_angle)
                return 1;
    return 0;
}

/* 1 when the element map is inside out at a node, where no integration point sees it. */
static int sbi_cell_is_folded(const sbi_assembly *assembly, int e, const sb_vec3 *u)
{
    const sb_domain *domain = assembly->domain;
    sbi_element element = sbi_domain_element(domain);
    int n = domain->nodes_per_cell;
    const int *cell = domain->cells + (size_t)e * (size_t)n;
    for (int k = 0; k < n; k++) {
        sb_real xi[3] = {0, 0, 0}, gradient[SB_MAX_ELEMENT_NODES][3];
        sb_vec3 column[3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
        sbi_element_node_point(element, k, xi);
        sbi_element_shape(element, xi, NULL, gradient);
        for (int a = 0; a < n; a++) {
            sb_vec3 x = sb_v3_add(assembly->reference[cell[a]], u[cell[a]]);
            for (int j = 0; j < 3; j++)
                column[j] = sb_v3_madd(column[j], gradient[a][j], x);
        }
        if (sb_v3_dot(column[0], sb_v3_cross(column[1], column[2])) <= 0) /* NaN where a custom element has no slope */
            return 1;
    }
    return 0;
}

/* A fold-over is a state into which violence drives quadratic elements: folded where no point sees it, the points so
 * far turned against each other that their forces balance. One rotation has one rest shape, so the cell comes undone.
 */
SBI_API int sbi_assembly_fold_fallback(const sbi_assembly *assembly, int e, const sb_vec3 *u, const sb_mat3 *f,
                                       sb_quat *rotation)
{
    const sb_domain *domain = assembly->domain;
    int q = domain->points_per_cell, ordinary = q - domain->mean_points;
    sb_quat shared;
    if (!sbi_cell_is_twisted(rotation, ordinary) || !sbi_cell_is_folded(assembly, e, u))
        return 0;
    shared = sb_m3_polar(sbi_assembly_mean_gradient(f, domain->weights + (size_t)e * (size_t)q, ordinary), rotation[0]);
    for (int p = 0; p < q; p++)
        rotation[p] = shared;
    return 1;
}
