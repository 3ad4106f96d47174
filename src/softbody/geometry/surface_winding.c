/* surface_winding: winding numbers of points, exact and by clusters. */
#include "surface_tree.h"

/* ---- winding number ------------------------------------------------------------------------------------------ */

static void sbi_surface_angle_add(sbi_surface_angle *sum, double re, double im)
{
    double size = (re < 0 ? -re : re) + (im < 0 ? -im : im), x, y;
    if (!(size > 0))
        return; /* the point is a corner, or 0 times infinity */
    re /= size;
    im /= size;
    x = sum->re * re - sum->im * im;
    y = sum->re * im + sum->im * re;
    if (sum->im >= 0 && im >= 0 && y < 0)
        sum->turns++;
    if (sum->im < 0 && im < 0 && y > 0)
        sum->turns--;
    sum->re = x;
    sum->im = y;
    if (x * x + y * y < 1e-100) {
        sum->re *= 1e100;
        sum->im *= 1e100;
    }
}

/* Van Oosterom, Strackee 1983: its tangent from the corners relative to the eye. */
SBI_API void sbi_surface_angle_of(const sb_vec3 x[3], sb_vec3 eye, sbi_surface_angle *sum)
{
    sb_vec3 a, b, c;
    double la, lb, lc;
    a = sb_v3_sub(x[0], eye), b = sb_v3_sub(x[1], eye), c = sb_v3_sub(x[2], eye);
    la = (double)sb_v3_norm(a), lb = (double)sb_v3_norm(b), lc = (double)sb_v3_norm(c);
    sbi_surface_angle_add(
        sum, la * lb * lc + (double)sb_v3_dot(a, b) * lc + (double)sb_v3_dot(b, c) * la + (double)sb_v3_dot(c, a) * lb,
        (double)sb_v3_dot(a, sb_v3_cross(b, c)));
}

SBI_API double sbi_surface_angle_turns(const sbi_surface_angle *sum)
{
    return (double)sum->turns + sbi_dense_atan2(sum->im, sum->re) / 6.283185307179586;
}

/* Winding numbers of a node's four children as seen from far: dipole and first moment (Barill et al. 2018, eqs. 7 to
 * 9); near[k] > 0 where the child is closer than twice its radius, and its number means nothing. */
static void sbi_surface_far_fields(const sbi_surface_cluster *cluster, const float p[3],
                                   float number[SBI_SURFACE_WIDTH], float near[SBI_SURFACE_WIDTH])
{
    const float(*f)[SBI_SURFACE_WIDTH] = cluster->f;
    for (int k = 0; k < SBI_SURFACE_WIDTH; k++) {
        float x = f[0][k] - p[0], y = f[1][k] - p[1], z = f[2][k] - p[2], square = x * x + y * y + z * z;
        float reach = 4.0f * f[SBI_CLUSTER_RADIUS][k] * f[SBI_CLUSTER_RADIUS][k] + 1.0e-24f; /* cube: no overflow */
        float inverse = 1.0f / (square >= reach ? square : 1.0f), cube = inverse * (float)sqrt((double)inverse);
        float dipole = x * f[5][k] + y * f[6][k] + z * f[7][k], trace = f[8][k] + f[9][k] + f[10][k];
        float twist = x * x * f[8][k] + y * y * f[9][k] + z * z * f[10][k] +
                      2.0f * (y * z * f[11][k] + x * z * f[12][k] + x * y * f[13][k]);
        number[k] = (dipole + trace - 3.0f * twist * inverse) * cube * 0.079577472f; /* 1 / (4 pi) */
        near[k] = reach - square;
    }
}

SBI_API double sbi_surface_winding(const sb_surface *s, sb_vec3 eye)
{
    sbi_surface_angle angle = sbi_surface_angle_zero();
    float p[3], number[SBI_SURFACE_WIDTH], near[SBI_SURFACE_WIDTH];
    int stack[SBI_SURFACE_STACK + SBI_SURFACE_WIDTH], top = 0, count;
    double far = 0;
    sbi_surface_to_local(s, eye, p);
    stack[top++] = 0;
    while (top > 0) {
        int child = stack[--top];
        if (child < 0) {
            const sbi_surface_leaf *leaf = s->leaf + ~child;
            for (int k = 0; k < SBI_SURFACE_WIDTH && leaf->triangle[k] != SBI_SURFACE_NO_TRIANGLE; k++)
                if (leaf->triangle[k] >= 0 || s->shape[~leaf->triangle[k]] != SBI_SURFACE_FLAT)
                    sbi_surface_angle_of(s->exact[SBI_SURFACE_WIDTH * ~child + k], eye, &angle);
            continue;
        }
        sbi_surface_far_fields(s->cluster + child, p, number, near);
        count = sbi_surface_child_count(s->tree + child);
        for (int k = 0; k < count; k++) {
            if (near[k] < 0)
                far += (double)number[k];
            else
                stack[top++] = s->tree[child].child[k];
        }
    }
    return far + sbi_surface_angle_turns(&angle);
}

/* Scales a point; 0 where a surface has no winding number to speak of. */
static int sbi_surface_eye(const sb_surface *s, sb_vec3 point, sb_vec3 *eye)
{
    if (!s)
        return 0;
    *eye = sb_v3_scale(s->scale, point);
    return sbi_surface_far(s, *eye) <= (sb_real)SBI_SURFACE_FAR;
}

SB_API sb_real sb_surface_winding_number(const sb_surface *surface, sb_vec3 point)
{
    sb_vec3 eye;
    return sbi_surface_eye(surface, point, &eye) ? (sb_real)sbi_surface_winding(surface, eye) : 0;
}

SB_API sb_real sb_surface_winding_number_exact(const sb_surface *surface, sb_vec3 point)
{
    sbi_surface_angle angle = sbi_surface_angle_zero();
    sb_vec3 eye;
    if (!sbi_surface_eye(surface, point, &eye))
        return 0;
    for (int t = 0; t < surface->triangle_count; t++) {
        sb_vec3 x[3];
        sbi_surface_corners(surface, t, x);
        if (surface->shape[t] != SBI_SURFACE_FLAT)
            sbi_surface_angle_of(x, eye, &angle);
    }
    return (sb_real)sbi_surface_angle_turns(&angle);
}

SB_API int sb_surface_inside(const sb_surface *surface, sb_vec3 point)
{
    return sb_surface_winding_number(surface, point) >= (sb_real)0.5;
}
