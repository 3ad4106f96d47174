/* piece: moments of a part of a tet, and what follows from them. */
#include "piece.h"

#include <string.h>

#include "../mesh/element.h"

/* Index of an entry of a symmetric matrix among xx, yy, zz, yz, zx, xy. */
static int sbi_piece_entry(int i, int j) { return i == j ? i : 6 - i - j; }

/* ---- moments ---- */

/* Means over a whole face of products of barycentrics where a part is: L_0^2, L_1^2, L_2^2, L_0 L_1, L_1 L_2, L_2 L_0,
 * from its loads by the nodes of a tri6, L (2 L - 1) at corners and 4 L_a L_b between them. */
static void sbi_piece_face_products(const sb_real loads[6], sb_real products[6])
{
    for (int k = 0; k < 3; k++)
        products[3 + k] = loads[3 + k] / 4;
    for (int k = 0; k < 3; k++)
        products[k] = loads[k] + products[3 + k] + products[3 + (k + 2) % 3];
}

SBI_API sb_real sbi_piece_face_share(const sb_real *loads, int face_nodes)
{
    sb_real share = 0;
    for (int k = 0; k < face_nodes; k++)
        share += loads[k];
    return share;
}

static int sbi_piece_face_is_sound(const sb_real *loads, int face_nodes, sb_real slack)
{
    const sb_real share = sbi_piece_face_share(loads, face_nodes);
    const sb_real least = face_nodes == 6 ? -SB_EPSILON * share : 0; /* differences, of tri6; none is more than share */
    sb_real products[6];
    if (face_nodes == 6)
        sbi_piece_face_products(loads, products);
    else
        memcpy(products, loads, 3 * sizeof *products);
    for (int k = 0; k < face_nodes; k++)
        if (!(products[k] >= least))
            return 0;
    return share <= 1 + slack;
}

SBI_API int sbi_piece_is_sound(const sbi_piece *piece, int nodes)
{
    const sb_real slack = (sb_real)1e-3; /* rounding of places far from the origin */
    sb_real rest = 1;
    for (int face = 0; face < 4; face++)
        if (!sbi_piece_face_is_sound(piece->faces[face], sbi_piece_face_nodes(nodes), slack))
            return 0;
    for (int k = 0; k < 3; k++) {
        sb_real variance = piece->covariance[k]; /* of numbers in [0, 1] it is a quarter at most */
        if (!(piece->centroid[k] >= -slack) || !(variance >= -slack) || !(variance <= (sb_real)0.25 + slack) ||
            !sb_is_finite(piece->covariance[3 + k]))
            return 0;
        rest -= piece->centroid[k];
    }
    return piece->is == 1 && rest >= -slack;
}

SBI_API sbi_piece sbi_piece_make(sb_vec3 centroid, const sb_mat3 *covariance, int nodes, const sb_real *face_loads)
{
    const int face_nodes = sbi_piece_face_nodes(nodes);
    sbi_piece piece;
    memset(&piece, 0, sizeof piece);
    piece.is = 1;
    piece.centroid[0] = centroid.x;
    piece.centroid[1] = centroid.y;
    piece.centroid[2] = centroid.z;
    for (int i = 0; i < 3; i++)
        for (int j = i; j < 3; j++)
            piece.covariance[sbi_piece_entry(i, j)] = covariance->m[i][j];
    for (int face = 0; face < 4; face++)
        for (int k = 0; k < face_nodes; k++)
            piece.faces[face][k] = face_loads ? face_loads[face * face_nodes + k] : sbi_piece_whole_load(face_nodes, k);
    return piece;
}

/* ---- parts of faces ---- */

SBI_API int sbi_piece_is_whole_face(const sb_real *loads, int face_nodes)
{
    for (int k = 0; k < face_nodes; k++)
        if (loads[k] != sbi_piece_whole_load(face_nodes, k))
            return 0;
    return 1;
}

/* Three points of equal weight with the mean and the covariance of a part of a tri6. */
static void sbi_piece_spread_points(const sb_real loads[6], sb_real share, sb_real points[3][3])
{
    static const double at[3][2] = {{1.4142135623730951, 0}, /* their mean is 0, their covariance 1 */
                                    {-0.70710678118654757, 1.2247448713915890},
                                    {-0.70710678118654757, -1.2247448713915890}};
    sb_real products[6], mean[2], variance[2], most, l[2][2];
    sbi_piece_face_products(loads, products);
    mean[0] = (products[1] + products[3] + products[4]) / share;
    mean[1] = (products[2] + products[4] + products[5]) / share;
    variance[0] = sb_max(products[1] / share - mean[0] * mean[0], 0);
    variance[1] = sb_max(products[2] / share - mean[1] * mean[1], 0);
    l[0][0] = sb_sqrt(variance[0]);
    l[1][0] = l[0][0] > 0 ? (products[4] / share - mean[0] * mean[1]) / l[0][0] : 0;
    most = sb_sqrt(variance[1]); /* more than that is rounding */
    l[1][0] = sb_max(sb_min(l[1][0], most), -most);
    l[1][1] = sb_sqrt(sb_max(variance[1] - l[1][0] * l[1][0], 0));
    for (int p = 0; p < 3; p++) {
        points[p][0] = mean[0] + l[0][0] * (sb_real)at[p][0];
        points[p][1] = mean[1] + l[1][0] * (sb_real)at[p][0] + l[1][1] * (sb_real)at[p][1];
        points[p][2] = 0;
    }
}

SBI_API int sbi_piece_face_points(const sb_real *loads, int face_nodes, sb_real points[3][3], sb_real weights[3])
{
    const sb_real share = sbi_piece_face_share(loads, face_nodes);
    const int count = !(share > 0) ? 0 : face_nodes == 6 ? 3 : 1;
    if (count == 3)
        sbi_piece_spread_points(loads, share, points);
    if (count == 1) {
        points[0][0] = loads[1] / share;
        points[0][1] = loads[2] / share;
        points[0][2] = 0;
    }
    for (int p = 0; p < count; p++)
        weights[p] = share / (sb_real)(2 * count);
    return count;
}

/* ---- points ---- */

/* L L^T = S; where nothing but rounding is left of a pivot (a flat piece) its column is 0. */
static void sbi_piece_factor(const sbi_piece *piece, sb_real l[3][3])
{
    memset(l, 0, 9 * sizeof(sb_real));
    for (int j = 0; j < 3; j++) {
        sb_real whole = piece->covariance[j], pivot = whole;
        for (int k = 0; k < j; k++)
            pivot -= l[j][k] * l[j][k];
        if (!(pivot > 16 * SB_EPSILON * whole))
            continue;
        l[j][j] = sb_sqrt(pivot);
        for (int i = j + 1; i < 3; i++) {
            sb_real sum = piece->covariance[sbi_piece_entry(i, j)];
            for (int k = 0; k < j; k++)
                sum -= l[i][k] * l[j][k];
            l[i][j] = sum / l[j][j];
        }
    }
}

SBI_API void sbi_piece_points(const sbi_piece *piece, sb_real points[4][3])
{
    static const signed char corners[4][3] = {{1, 1, 1}, {1, -1, -1}, {-1, 1, -1}, {-1, -1, 1}};
    sb_real l[3][3];
    sbi_piece_factor(piece, l);
    for (int p = 0; p < 4; p++)
        for (int i = 0; i < 3; i++) {
            points[p][i] = piece->centroid[i];
            for (int k = 0; k <= i; k++)
                points[p][i] += l[i][k] * (sb_real)corners[p][k];
        }
}

/* ---- masses ---- */

/* The functions that lumped masses of tet10 are integrals of, at a point. */
static void sbi_piece_weights(const sb_real bary[4], sb_real weights[10])
{
    const sb_real corner = (sb_real)5 / 18, end = (sb_real)13 / 54;
    for (int a = 0; a < 4; a++)
        weights[a] = corner * bary[a] * bary[a];
    for (int e = 0; e < 6; e++) {
        int ends[3];
        sb_element_edge(SB_TET10, e, ends);
        sb_real p = bary[ends[0]], q = bary[ends[1]];
        weights[4 + e] = 2 * p * q + end * (p * p + q * q);
    }
}

SBI_API void sbi_piece_lumps(const sbi_piece *piece, int nodes, sb_real volume, sb_real *masses, sb_real *load)
{
    const sb_real least = SB_EPSILON; /* what rounding may take of a node's part */
    sb_real points[4][3], bary[4], shape[10], weights[10];
    int count = nodes == 4 ? 1 : 4;
    if (nodes == 4)
        memcpy(points[0], piece->centroid, sizeof points[0]);
    else
        sbi_piece_points(piece, points);
    for (int a = 0; a < nodes; a++) {
        masses[a] = 0;
        if (load)
            load[a] = 0;
    }
    for (int p = 0; p < count; p++) {
        sb_element_shape(SB_TET4, points[p], bary, NULL);
        if (nodes == 4)
            memcpy(weights, bary, sizeof bary);
        else
            sbi_piece_weights(bary, weights);
        if (load)
            sb_element_shape(nodes == 4 ? SB_TET4 : SB_TET10, points[p], shape, NULL);
        for (int a = 0; a < nodes; a++) {
            masses[a] += weights[a] / (sb_real)count;
            if (load)
                load[a] += volume * shape[a] / (sb_real)count;
        }
    }
    for (int a = 0; a < nodes; a++)
        masses[a] = volume * sb_max(masses[a], least);
}

SBI_API void sbi_piece_level(int nodes, sb_real volume, sb_real share, sb_real *masses)
{
    const sb_real corner = nodes == 4 ? (sb_real)1 / 4 : (sb_real)1 / 36, middle = (sb_real)4 / 27;
    for (int a = 0; a < nodes; a++)
        masses[a] += share * (volume * (a < 4 ? corner : middle) - masses[a]);
}

SBI_API void sbi_piece_mass(const sbi_piece *piece, int nodes, sb_real volume, sb_real *mass)
{
    sb_real points[4][3], shape[10];
    sbi_piece_points(piece, points); /* exact to degree 2 */
    memset(mass, 0, (size_t)(nodes * nodes) * sizeof *mass);
    for (int p = 0; p < 4; p++) {
        sb_element_shape(nodes == 4 ? SB_TET4 : SB_TET10, points[p], shape, NULL);
        for (int a = 0; a < nodes; a++)
            for (int b = 0; b < nodes; b++)
                mass[a * nodes + b] += volume / 4 * shape[a] * shape[b];
    }
}
