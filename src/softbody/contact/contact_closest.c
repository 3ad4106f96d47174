/* contact_closest: the point of a face nearest to another, and when a point on its way meets a face. */
#include <math.h>

#include "contact_pairs.h"

/* ---- faces as triangles of their nodes ---- */

static const signed char sbi_closest_tri3[1][3] = {{0, 1, 2}};
static const signed char sbi_closest_quad4[2][3] = {{0, 1, 2}, {0, 2, 3}};
static const signed char sbi_closest_tri6[4][3] = {{0, 3, 5}, {3, 1, 4}, {5, 4, 2}, {3, 4, 5}};
static const signed char sbi_closest_quad8[6][3] = {{0, 4, 7}, {4, 1, 5}, {5, 2, 6}, {6, 3, 7}, {4, 5, 6}, {4, 6, 7}};
static const signed char sbi_closest_quad9[8][3] = {{8, 0, 4}, {8, 4, 1}, {8, 1, 5}, {8, 5, 2},
                                                    {8, 2, 6}, {8, 6, 3}, {8, 3, 7}, {8, 7, 0}};

static const signed char (*sbi_closest_parts(const sbi_contact_kind *kind))[3]
{
    switch (kind->nodes) {
    case 3: return sbi_closest_tri3;
    case 4: return sbi_closest_quad4;
    case 6: return sbi_closest_tri6;
    case 8: return sbi_closest_quad8;
    default: return sbi_closest_quad9;
    }
}

SBI_API int sbi_closest_part_count(const sbi_contact_kind *kind)
{
    switch (kind->nodes) {
    case 3: return 1;
    case 4: return 2;
    case 6: return 4;
    case 8: return 6;
    default: return 8;
    }
}

SBI_API int sbi_closest_part_node(const sbi_contact_kind *kind, int part, int k)
{
    return sbi_closest_parts(kind)[part][k];
}

/* ---- nearest points ---- */

static void sbi_closest_set(sb_real *b, sb_real b0, sb_real b1, sb_real b2) { b[0] = b0, b[1] = b1, b[2] = b2; }

/* Barycentric coordinates of the point of a triangle nearest to p. Source: Ericson, Real-Time Collision Detection,
 * 5.1.5. */
static void sbi_closest_on_triangle(const sb_vec3 *x, sb_vec3 p, sb_real b[3])
{
    sb_vec3 ab = sb_v3_sub(x[1], x[0]), ac = sb_v3_sub(x[2], x[0]);
    sb_vec3 ap = sb_v3_sub(p, x[0]), bp = sb_v3_sub(p, x[1]), cp = sb_v3_sub(p, x[2]);
    sb_real d1 = sb_v3_dot(ab, ap), d2 = sb_v3_dot(ac, ap), d3 = sb_v3_dot(ab, bp), d4 = sb_v3_dot(ac, bp);
    sb_real d5 = sb_v3_dot(ab, cp), d6 = sb_v3_dot(ac, cp), va, vb, vc, sum;
    if (d1 <= 0 && d2 <= 0) {
        sbi_closest_set(b, 1, 0, 0);
        return;
    }
    if (d3 >= 0 && d4 <= d3) {
        sbi_closest_set(b, 0, 1, 0);
        return;
    }
    if (d6 >= 0 && d5 <= d6) {
        sbi_closest_set(b, 0, 0, 1);
        return;
    }
    vc = d1 * d4 - d3 * d2;
    vb = d5 * d2 - d1 * d6;
    va = d3 * d6 - d5 * d4;
    sum = va + vb + vc;
    if (vc <= 0 && d1 >= 0 && d3 <= 0 && d1 - d3 > 0)
        sbi_closest_set(b, 1 - d1 / (d1 - d3), d1 / (d1 - d3), 0);
    else if (vb <= 0 && d2 >= 0 && d6 <= 0 && d2 - d6 > 0)
        sbi_closest_set(b, 1 - d2 / (d2 - d6), 0, d2 / (d2 - d6));
    else if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0 && d4 - d3 + d5 - d6 > 0)
        sbi_closest_set(b, 0, (d5 - d6) / (d4 - d3 + d5 - d6), (d4 - d3) / (d4 - d3 + d5 - d6));
    else if (sum > 0)
        sbi_closest_set(b, 1 - vb / sum - vc / sum, vb / sum, vc / sum);
    else
        sbi_closest_set(b, 1, 0, 0);
}

static sb_vec3 sbi_closest_mean(const sb_real *shares, const sb_vec3 *x, int count)
{
    sb_vec3 sum = sb_v3_scale(shares[0], x[0]);
    for (int a = 1; a < count; a++)
        sum = sb_v3_madd(sum, shares[a], x[a]);
    return sum;
}

/* The triangle of a face nearest to p, and the nearest point's coordinates in it. */
static int sbi_closest_part(const sbi_contact_kind *kind, const sb_vec3 *x, sb_vec3 p, sb_real b[3])
{
    const signed char(*parts)[3] = sbi_closest_parts(kind);
    sb_real least = SB_REAL_MAX;
    int best = 0;
    for (int part = 0; part < sbi_closest_part_count(kind); part++) {
        const sb_vec3 at[3] = {x[(int)parts[part][0]], x[(int)parts[part][1]], x[(int)parts[part][2]]};
        sb_real own[3], square;
        sb_vec3 away;
        sbi_closest_on_triangle(at, p, own);
        away = sb_v3_sub(p, sbi_closest_mean(own, at, 3));
        square = sb_v3_dot(away, away);
        if (square < least) {
            least = square;
            best = part;
            sbi_closest_set(b, own[0], own[1], own[2]);
        }
    }
    return best;
}

/* Parameters go back into the face. */
static void sbi_closest_clamp(const sbi_contact_kind *kind, sb_real xi[3])
{
    if (kind->corners == 4) {
        xi[0] = sb_max((sb_real)-1, sb_min(xi[0], (sb_real)1));
        xi[1] = sb_max((sb_real)-1, sb_min(xi[1], (sb_real)1));
        return;
    }
    xi[0] = sb_max((sb_real)0, xi[0]);
    xi[1] = sb_max((sb_real)0, xi[1]);
    if (xi[0] + xi[1] > 1) {
        sb_real sum = xi[0] + xi[1];
        xi[0] /= sum;
        xi[1] = 1 - xi[0];
    }
}

/* One step of Gauss and Newton on the curved face. 0: the parameters are as good as they get. */
static int sbi_closest_improve(const sbi_contact_kind *kind, const sb_vec3 *x, sb_vec3 p, sb_real xi[3])
{
    const sb_real before[2] = {xi[0], xi[1]};
    sb_real shape[SB_MAX_FACE_NODES], gradient[SB_MAX_FACE_NODES][3], rr, rs, ss, r1, s1, det;
    sb_vec3 r = {0, 0, 0}, s = {0, 0, 0}, away;
    sb_element_shape(kind->type, xi, shape, gradient);
    for (int a = 0; a < kind->nodes; a++) {
        r = sb_v3_madd(r, gradient[a][0], x[a]);
        s = sb_v3_madd(s, gradient[a][1], x[a]);
    }
    away = sb_v3_sub(p, sbi_closest_mean(shape, x, kind->nodes));
    rr = sb_v3_dot(r, r), rs = sb_v3_dot(r, s), ss = sb_v3_dot(s, s);
    r1 = sb_v3_dot(r, away), s1 = sb_v3_dot(s, away);
    det = rr * ss - rs * rs;
    if (!(det > SB_EPSILON * rr * ss))
        return 0;
    xi[0] += (ss * r1 - rs * s1) / det;
    xi[1] += (rr * s1 - rs * r1) / det;
    sbi_closest_clamp(kind, xi);
    /* the next step would change them by about the square of this */
    return (xi[0] - before[0]) * (xi[0] - before[0]) + (xi[1] - before[1]) * (xi[1] - before[1]) > SB_EPSILON;
}

enum { SBI_CLOSEST_STEPS = 3 };

SBI_API void sbi_closest_on_face(const sbi_contact_kind *kind, const sb_vec3 *x, sb_vec3 p, sbi_closest *closest)
{
    sb_real b[3], xi[3] = {0, 0, 0};
    int part;
    if (kind->nodes == 3) {
        sbi_closest_on_triangle(x, p, closest->shares);
        closest->point = sbi_closest_mean(closest->shares, x, 3);
        return;
    }
    part = sbi_closest_part(kind, x, p, b);
    for (int k = 0; k < 3; k++) {
        sb_real at[3] = {0, 0, 0};
        (void)sb_element_node_point(kind->type, sbi_closest_part_node(kind, part, k), at);
        xi[0] += b[k] * at[0];
        xi[1] += b[k] * at[1];
    }
    for (int i = 0; i < SBI_CLOSEST_STEPS && sbi_closest_improve(kind, x, p, xi); i++)
        continue;
    sb_element_shape(kind->type, xi, closest->shares, NULL);
    closest->point = sbi_closest_mean(closest->shares, x, kind->nodes);
}

/* ---- ways ---- */

SBI_API sb_real sbi_closest_height(const sb_vec3 *x, sb_vec3 p)
{
    sb_vec3 n = sb_v3_cross(sb_v3_sub(x[1], x[0]), sb_v3_sub(x[2], x[0]));
    sb_real size = sb_v3_norm(n);
    return size > 0 ? sb_v3_dot(n, sb_v3_sub(p, x[0])) / size : 0;
}

enum { SBI_CLOSEST_SECANTS = 4 };

/* A point that comes no nearer to the triangle than this share of its edge passes beside it. */
#define SBI_CLOSEST_BESIDE ((sb_real)0.01)

static int sbi_closest_is_beside(const sb_vec3 *x, sb_vec3 p)
{
    sb_real b[3], edge;
    sb_vec3 away, side = sb_v3_sub(x[1], x[0]), other = sb_v3_sub(x[2], x[0]);
    sbi_closest_on_triangle(x, p, b);
    away = sb_v3_sub(p, sbi_closest_mean(b, x, 3));
    edge = sb_max(sb_v3_dot(side, side), sb_v3_dot(other, other));
    return !(sb_v3_dot(away, away) <= SBI_CLOSEST_BESIDE * SBI_CLOSEST_BESIDE * edge);
}

SBI_API sb_real sbi_closest_meeting(const sb_vec3 *x, const sb_vec3 *v, sb_vec3 p, sb_vec3 q, sb_real *depth)
{
    sb_vec3 at[3];
    sb_real low = 0, high = 1, before = sbi_closest_height(x, p), after, share = 0;
    for (int k = 0; k < 3; k++)
        at[k] = sb_v3_add(x[k], v[k]);
    after = sbi_closest_height(at, sb_v3_add(p, q));
    *depth = -after;
    if (!(before >= 0 && after < 0))
        return -1;
    for (int i = 0; i < SBI_CLOSEST_SECANTS; i++) {
        sb_real height;
        share = low + (high - low) * before / (before - after);
        for (int k = 0; k < 3; k++)
            at[k] = sb_v3_madd(x[k], share, v[k]);
        height = sbi_closest_height(at, sb_v3_madd(p, share, q));
        if (height >= 0)
            low = share, before = height;
        else
            high = share, after = height;
    }
    return sbi_closest_is_beside(at, sb_v3_madd(p, share, q)) ? -1 : share;
}
