/* skeleton.h: does the skeleton of a tool cross a triangle? For sweeps that look whether anything passed through. Tools
 * are internal: for tests that hold an implementation of their own.
 *
 * Segments are decided without rounding, by signs of determinants whose terms are summed exactly. Boxes and ways of
 * points are decided to rounding. */
#ifndef SKELETON_H
#define SKELETON_H

#include <math.h>
#include <string.h>

/* ---- on which side of a plane, exactly ---- */

/* A sum of numbers without rounding, as numbers that do not overlap, the smallest first (Shewchuk 1997). */
typedef struct skeleton_sum {
    int count;
    double part[96];
} skeleton_sum;

static inline void skeleton_add(skeleton_sum *sum, double x)
{
    int kept = 0;
    for (int i = 0; i < sum->count; i++) {
        double a = sum->part[i], s = x + a, other = s - x, rest = (x - (s - other)) + (a - other);
        if (rest != 0)
            sum->part[kept++] = rest;
        x = s;
    }
    if (x != 0)
        sum->part[kept++] = x;
    sum->count = kept;
}

static inline void skeleton_add_product(skeleton_sum *sum, double a, double b, double c)
{
    double p = a * b, rest = fma(a, b, -p), pc = p * c, rest_c = rest * c;
    skeleton_add(sum, fma(rest, c, -rest_c));
    skeleton_add(sum, rest_c);
    skeleton_add(sum, fma(p, c, -pc));
    skeleton_add(sum, pc);
}

static inline double skeleton_det(const double a[3], const double b[3], const double c[3])
{
    return a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0]);
}

/* 1, 0 or -1: the sign of det(a - d, b - d, c - d), by the 24 terms of its rows (x, 1). */
static inline int skeleton_side(const double a[3], const double b[3], const double c[3], const double d[3])
{
    static const int order[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    const double *row[4], *left[3];
    double u[3], v[3], w[3], det, size = 0;
    skeleton_sum sum = {0, {0}};
    row[0] = a, row[1] = b, row[2] = c, row[3] = d;
    for (int k = 0; k < 3; k++)
        u[k] = a[k] - d[k], v[k] = b[k] - d[k], w[k] = c[k] - d[k];
    det = skeleton_det(u, v, w);
    for (int i = 0; i < 6; i++)
        size += fabs(u[order[i][0]] * v[order[i][1]] * w[order[i][2]]);
    if (fabs(det) > 1e-14 * size) /* far above its rounding */
        return det > 0 ? 1 : -1;
    for (int out = 0; out < 4; out++) {
        int sign = out % 2 ? 1 : -1; /* of the minor without row `out`, by the last column */
        for (int i = 0, n = 0; i < 4; i++)
            if (i != out)
                left[n++] = row[i];
        for (int i = 0; i < 6; i++)
            skeleton_add_product(&sum, (i < 3 ? sign : -sign) * left[order[i][0]][0], left[order[i][1]][1],
                                 left[order[i][2]][2]);
    }
    return sum.count == 0 ? 0 : sum.part[sum.count - 1] > 0 ? 1 : -1;
}

/* Does a segment go through a triangle? Touching it with an end or at its border is going through; a segment that lies
 * in its plane does not. */
static inline int skeleton_segment_crosses(const double p[3], const double q[3], double t[3][3])
{
    int before = skeleton_side(t[0], t[1], t[2], p), behind = skeleton_side(t[0], t[1], t[2], q), s[3];
    if (before == behind)
        return 0;
    for (int i = 0; i < 3; i++)
        s[i] = skeleton_side(t[i], t[(i + 1) % 3], p, q);
    return (s[0] >= 0 && s[1] >= 0 && s[2] >= 0) || (s[0] <= 0 && s[1] <= 0 && s[2] <= 0);
}

/* ---- a box, to rounding ---- */

/* Does axis separate the box [-half, half] from the triangle? */
static inline int skeleton_axis_separates(const double axis[3], const double half[3], double t[3][3])
{
    double low = 1e300, high = -1e300, reach = 0;
    for (int k = 0; k < 3; k++) {
        double at = axis[0] * t[k][0] + axis[1] * t[k][1] + axis[2] * t[k][2];
        low = fmin(low, at), high = fmax(high, at);
        reach += half[k] * fabs(axis[k]);
    }
    return low > reach || high < -reach;
}

static inline void skeleton_cross(const double a[3], const double b[3], double c[3])
{
    c[0] = a[1] * b[2] - a[2] * b[1], c[1] = a[2] * b[0] - a[0] * b[2], c[2] = a[0] * b[1] - a[1] * b[0];
}

/* Two convex bodies are apart when the normal of a side, or a direction across an edge of each, separates them. */
static inline int skeleton_box_meets(const double half[3], double t[3][3])
{
    double edge[3][3], axis[3];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            edge[i][k] = t[(i + 1) % 3][k] - t[i][k];
    skeleton_cross(edge[0], edge[1], axis);
    if (skeleton_axis_separates(axis, half, t))
        return 0;
    for (int k = 0; k < 3; k++) {
        double side[3] = {0, 0, 0};
        side[k] = 1;
        if (skeleton_axis_separates(side, half, t))
            return 0;
        for (int i = 0; i < 3; i++) {
            skeleton_cross(side, edge[i], axis);
            if (skeleton_axis_separates(axis, half, t))
                return 0;
        }
    }
    return 1;
}

/* ---- ways of points, to rounding ---- */

/* A triangle seen from a point, both on straight ways: corners at the start and at the end. */
typedef struct skeleton_way {
    double start[3][3], end[3][3];
} skeleton_way;

static inline int skeleton_is_inside(const skeleton_way *way, double time)
{
    double x[3][3], normal[3], other[3], out[3], edge[2][3];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            x[i][k] = way->start[i][k] + time * (way->end[i][k] - way->start[i][k]);
    for (int k = 0; k < 3; k++)
        edge[0][k] = x[1][k] - x[0][k], edge[1][k] = x[2][k] - x[0][k];
    skeleton_cross(edge[0], edge[1], normal);
    for (int i = 0; i < 3; i++) { /* the point is the origin */
        skeleton_cross(x[i], x[(i + 1) % 3], other);
        out[i] = other[0] * normal[0] + other[1] * normal[1] + other[2] * normal[2];
    }
    return out[0] >= 0 && out[1] >= 0 && out[2] >= 0;
}

/* Is there a time in [from, to] at which the height over the triangle's plane, a cubic with these Bernstein
 * coefficients there, is 0, and the point within the triangle? */
static inline int skeleton_seek(const skeleton_way *way, const double b[4], double from, double to, int depth)
{
    double left[4], right[4], middle = 0.5 * (from + to);
    if ((b[0] > 0 && b[1] > 0 && b[2] > 0 && b[3] > 0) || (b[0] < 0 && b[1] < 0 && b[2] < 0 && b[3] < 0))
        return 0;
    if (depth == 0)
        return skeleton_is_inside(way, middle);
    left[0] = b[0], right[3] = b[3];
    left[1] = 0.5 * (b[0] + b[1]), right[2] = 0.5 * (b[2] + b[3]);
    left[2] = 0.5 * left[1] + 0.25 * (b[1] + b[2]), right[1] = 0.5 * right[2] + 0.25 * (b[1] + b[2]);
    left[3] = right[0] = 0.5 * (left[2] + right[1]);
    return skeleton_seek(way, left, from, middle, depth - 1) || skeleton_seek(way, right, middle, to, depth - 1);
}

static inline int skeleton_way_crosses(const skeleton_way *way)
{
    const double(*s)[3] = way->start, (*e)[3] = way->end;
    double b[4];
    b[0] = skeleton_det(s[0], s[1], s[2]);
    b[1] = (skeleton_det(e[0], s[1], s[2]) + skeleton_det(s[0], e[1], s[2]) + skeleton_det(s[0], s[1], e[2])) / 3;
    b[2] = (skeleton_det(s[0], e[1], e[2]) + skeleton_det(e[0], s[1], e[2]) + skeleton_det(e[0], e[1], s[2])) / 3;
    b[3] = skeleton_det(e[0], e[1], e[2]);
    return skeleton_seek(way, b, 0, 1, 40);
}

/* ---- of tools ---- */

static inline void skeleton_number(sb_vec3 v, double x[3])
{
    x[0] = (double)v.x, x[1] = (double)v.y, x[2] = (double)v.z;
}

/* Does the skeleton of capsules, or a box's core, meet a triangle in space, as they stand? 0 for other shapes. */
static inline int skeleton_meets(const sbi_tool *tool, const sb_vec3 *chain, const sb_pose *pose,
                                 const sb_vec3 triangle[3])
{
    sb_vec3 points[SBI_TOOL_MAX_SKELETON];
    int ends[SB_TOOL_MAX_POINTS][2], segments = sbi_tool_segments(tool, ends, SB_TOOL_MAX_POINTS);
    double t[3][3], half[3], p[3], q[3];
    sbi_tool_skeleton(tool, chain, points, SBI_TOOL_MAX_SKELETON);
    for (int i = 0; i < 3; i++)
        skeleton_number(triangle[i], t[i]);
    if (sbi_tool_get_shape(tool) == SB_TOOL_BOX) {
        for (int i = 0; i < 3; i++)
            skeleton_number(sbi_pose_to_tool(pose, triangle[i]), t[i]);
        skeleton_number(points[7], half);
        return skeleton_box_meets(half, t);
    }
    for (int i = 0; i < segments; i++) {
        skeleton_number(sbi_pose_to_space(pose, points[ends[i][0]]), p);
        skeleton_number(sbi_pose_to_space(pose, points[ends[i][1]]), q);
        if (skeleton_segment_crosses(p, q, t))
            return 1;
    }
    return 0;
}

/* Does a point of the skeleton (a sphere's centre, the ends of segments, nodes of a mesh) go through a triangle, which
 * moves too, on its straight way from one pose to the other? */
static inline int skeleton_passes(const sbi_tool *tool, const sb_vec3 *chain0, const sb_pose *from,
                                  const sb_vec3 triangle0[3], const sb_vec3 *chain1, const sb_pose *to,
                                  const sb_vec3 triangle1[3])
{
    sb_vec3 start[SBI_TOOL_MAX_SKELETON], end[SBI_TOOL_MAX_SKELETON];
    int count = sbi_tool_skeleton(tool, chain0, start, SBI_TOOL_MAX_SKELETON);
    sbi_tool_skeleton(tool, chain1, end, SBI_TOOL_MAX_SKELETON);
    for (int i = 0; i < count; i++) {
        sb_vec3 p = sbi_pose_to_space(from, start[i]), q = sbi_pose_to_space(to, end[i]);
        skeleton_way way;
        for (int k = 0; k < 3; k++) {
            skeleton_number(sb_v3_sub(triangle0[k], p), way.start[k]);
            skeleton_number(sb_v3_sub(triangle1[k], q), way.end[k]);
        }
        if (skeleton_way_crosses(&way))
            return 1;
    }
    return 0;
}

#endif /* SKELETON_H */
