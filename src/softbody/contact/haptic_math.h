/* haptic_math: 3-vectors, rotations and poses in double for the 1 kHz call, whatever sb_real is. Internal. */
#ifndef SB_HAPTIC_MATH_H
#define SB_HAPTIC_MATH_H

#include "../base/dense.h"

typedef struct sbi_d3 {
    double x, y, z;
} sbi_d3;

typedef struct sbi_turn { /* unit quaternion */
    double w, x, y, z;
} sbi_turn;

typedef struct sbi_d_pose { /* of a tool, in space */
    sbi_d3 position;        /* m */
    sbi_turn rotation;      /* tool to space */
} sbi_d_pose;

typedef struct sbi_d_wrench {
    sbi_d3 force, torque; /* N, N m about the pose's position */
} sbi_d_wrench;

SB_INLINE sbi_d3 sbi_d(double x, double y, double z)
{
    sbi_d3 v;
    v.x = x;
    v.y = y;
    v.z = z;
    return v;
}
SB_INLINE sbi_d3 sbi_d_from(const double v[3]) { return sbi_d(v[0], v[1], v[2]); }
SB_INLINE sbi_d3 sbi_d_of(sb_vec3 v) { return sbi_d((double)v.x, (double)v.y, (double)v.z); }
SB_INLINE void sbi_d_put(double to[3], sbi_d3 v) { to[0] = v.x, to[1] = v.y, to[2] = v.z; }
SB_INLINE sbi_d3 sbi_d_add(sbi_d3 a, sbi_d3 b) { return sbi_d(a.x + b.x, a.y + b.y, a.z + b.z); }
SB_INLINE sbi_d3 sbi_d_sub(sbi_d3 a, sbi_d3 b) { return sbi_d(a.x - b.x, a.y - b.y, a.z - b.z); }
SB_INLINE sbi_d3 sbi_d_scale(double s, sbi_d3 a) { return sbi_d(s * a.x, s * a.y, s * a.z); }
/* a + s b */
SB_INLINE sbi_d3 sbi_d_madd(sbi_d3 a, double s, sbi_d3 b) { return sbi_d(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z); }
SB_INLINE double sbi_d_dot(sbi_d3 a, sbi_d3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
SB_INLINE sbi_d3 sbi_d_cross(sbi_d3 a, sbi_d3 b)
{
    return sbi_d(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
SB_INLINE double sbi_d_norm(sbi_d3 a) { return sqrt(sbi_d_dot(a, a)); }
/* a without its part along the unit vector n */
SB_INLINE sbi_d3 sbi_d_across(sbi_d3 a, sbi_d3 n) { return sbi_d_madd(a, -sbi_d_dot(a, n), n); }
/* 1 when |x| <= limit, 0 also for NaN */
SB_INLINE int sbi_d_within(double x, double limit) { return fabs(x) <= limit; }
SB_INLINE int sbi_d3_within(sbi_d3 a, double limit)
{
    return sbi_d_within(a.x, limit) && sbi_d_within(a.y, limit) && sbi_d_within(a.z, limit);
}

SB_INLINE sbi_turn sbi_turn_make(double w, double x, double y, double z)
{
    sbi_turn q;
    q.w = w;
    q.x = x;
    q.y = y;
    q.z = z;
    return q;
}
/* q made a unit quaternion; `fallback` where its length does not allow it. */
SB_INLINE sbi_turn sbi_turn_unit(sbi_turn q, sbi_turn fallback)
{
    double square = q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z, scale;
    if (!(square > 1e-12) || !sbi_d_within(square, 1e12))
        return fallback;
    scale = 1 / sqrt(square);
    return sbi_turn_make(scale * q.w, scale * q.x, scale * q.y, scale * q.z);
}
/* First b, then a. Sums only: no - and + in turn, as in sb_quat_mul. */
SB_INLINE sbi_turn sbi_turn_mul(sbi_turn a, sbi_turn b)
{
    double x = -a.x, y = -a.y, z = -a.z;
    return sbi_turn_make(a.w * b.w + x * b.x + y * b.y + z * b.z, a.w * b.x + a.x * b.w + a.y * b.z + z * b.y,
                         a.w * b.y + x * b.z + a.y * b.w + a.z * b.x, a.w * b.z + a.x * b.y + y * b.x + a.z * b.w);
}
SB_INLINE sbi_d3 sbi_turn_apply(sbi_turn q, sbi_d3 v)
{
    sbi_d3 axis = sbi_d(q.x, q.y, q.z), t = sbi_d_scale(2, sbi_d_cross(axis, v));
    return sbi_d_add(sbi_d_madd(v, q.w, t), sbi_d_cross(axis, t));
}
/* The same rotation as the images of the axes: for many vectors. */
typedef struct sbi_d_axes {
    sbi_d3 x, y, z;
} sbi_d_axes;
SB_INLINE sbi_d_axes sbi_turn_axes(sbi_turn q)
{
    sbi_d_axes a;
    double x = 2 * q.x, y = 2 * q.y, z = 2 * q.z;
    double wx = q.w * x, wy = q.w * y, wz = q.w * z, xx = q.x * x, xy = q.x * y, xz = q.x * z;
    double yy = q.y * y, yz = q.y * z, zz = q.z * z;
    a.x = sbi_d(1 - yy - zz, xy + wz, xz - wy);
    a.y = sbi_d(xy - wz, 1 - xx - zz, yz + wx);
    a.z = sbi_d(xz + wy, yz - wx, 1 - xx - yy);
    return a;
}
SB_INLINE sbi_d3 sbi_axes_apply(const sbi_d_axes *a, sbi_d3 v)
{
    return sbi_d(a->x.x * v.x + a->y.x * v.y + a->z.x * v.z, a->x.y * v.x + a->y.y * v.y + a->z.y * v.z,
                 a->x.z * v.x + a->y.z * v.y + a->z.z * v.z);
}
/* q turned further by a small rotation vector (rad, in space); exact to its third power. */
SB_INLINE sbi_turn sbi_turn_further(sbi_turn q, sbi_d3 by)
{
    return sbi_turn_unit(sbi_turn_mul(sbi_turn_make(1, 0.5 * by.x, 0.5 * by.y, 0.5 * by.z), q), q);
}
/* The rotation vector (rad, in space, at most pi long) that leads from one rotation to another. Of small ones by the
 * series of 2 asin(s) / s, whose first term that is left out is 6e-18 of it. */
SB_INLINE sbi_d3 sbi_turn_between(sbi_turn from, sbi_turn to)
{
    sbi_turn q = sbi_turn_mul(to, sbi_turn_make(from.w, -from.x, -from.y, -from.z));
    double sign = q.w < 0 ? -1 : 1, square = q.x * q.x + q.y * q.y + q.z * q.z, scale;
    if (square < 1e-3) {
        scale = 2 + square * (1 / 3.0 + square * (3 / 20.0 + square * (5 / 56.0 + square * (35 / 576.0))));
    } else {
        double sine = sqrt(square);
        scale = 2 * sbi_dense_atan2(sine, sign * q.w) / sine;
    }
    return sbi_d_scale(sign * scale, sbi_d(q.x, q.y, q.z));
}
/* Of a row-major rotation matrix, which may be off by rounding; `fallback` for what is none, as a matrix of zeros. */
SB_INLINE sbi_turn sbi_turn_from_matrix(const double m[9], sbi_turn fallback)
{
    double trace = m[0] + m[4] + m[8];
    sbi_turn q;
    if (trace > 0)
        q = sbi_turn_make(1 + trace, m[7] - m[5], m[2] - m[6], m[3] - m[1]);
    else if (m[0] >= m[4] && m[0] >= m[8])
        q = sbi_turn_make(m[7] - m[5], 1 + m[0] - m[4] - m[8], m[1] + m[3], m[2] + m[6]);
    else if (m[4] >= m[8])
        q = sbi_turn_make(m[2] - m[6], m[1] + m[3], 1 + m[4] - m[0] - m[8], m[5] + m[7]);
    else
        q = sbi_turn_make(m[3] - m[1], m[2] + m[6], m[5] + m[7], 1 + m[8] - m[0] - m[4]);
    for (int i = 0; i < 3; i++) { /* rows of about unit length */
        double square = m[3 * i] * m[3 * i] + m[3 * i + 1] * m[3 * i + 1] + m[3 * i + 2] * m[3 * i + 2];
        if (!(square > 0.5) || !(square < 2))
            return fallback;
    }
    return sbi_turn_unit(q, fallback);
}
SB_INLINE void sbi_turn_to_matrix(sbi_turn q, double m[9])
{
    for (int j = 0; j < 3; j++) {
        sbi_d3 column = sbi_turn_apply(q, sbi_d(j == 0, j == 1, j == 2));
        m[j] = column.x, m[3 + j] = column.y, m[6 + j] = column.z;
    }
}

#endif /* SB_HAPTIC_MATH_H */
