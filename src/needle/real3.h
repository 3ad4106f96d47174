/* real3: 3-vectors and 3x3 matrices of double, for rods. Floor 6, internal. A rod is a million times stiffer along
 * itself than across: float holds neither its strains nor its matrices, so rods are computed in double in float
 * builds, too. */
#ifndef NDL_REAL3_H
#define NDL_REAL3_H

#include "api.h"

typedef struct ndli_v3 {
    double x, y, z;
} ndli_v3;

/* m[row][column] */
typedef struct ndli_m3 {
    double m[3][3];
} ndli_m3;

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
SB_INLINE ndli_v3 ndli_v(double x, double y, double z)
{
    ndli_v3 v;
    v.x = x;
    v.y = y;
    v.z = z;
    return v;
}
SB_INLINE ndli_v3 ndli_from(sb_vec3 a) { return ndli_v((double)a.x, (double)a.y, (double)a.z); }
SB_INLINE sb_vec3 ndli_to(ndli_v3 a) { return sb_v3((sb_real)a.x, (sb_real)a.y, (sb_real)a.z); }
SB_INLINE ndli_v3 ndli_add(ndli_v3 a, ndli_v3 b) { return ndli_v(a.x + b.x, a.y + b.y, a.z + b.z); }
SB_INLINE ndli_v3 ndli_sub(ndli_v3 a, ndli_v3 b) { return ndli_v(a.x - b.x, a.y - b.y, a.z - b.z); }
SB_INLINE ndli_v3 ndli_scale(double s, ndli_v3 a) { return ndli_v(s * a.x, s * a.y, s * a.z); }
/* a + s b */
SB_INLINE ndli_v3 ndli_madd(ndli_v3 a, double s, ndli_v3 b)
{
    return ndli_v(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z);
}
SB_INLINE double ndli_dot(ndli_v3 a, ndli_v3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
SB_INLINE ndli_v3 ndli_cross(ndli_v3 a, ndli_v3 b)
{
    return ndli_v(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
SB_INLINE double ndli_norm(ndli_v3 a) { return sqrt(ndli_dot(a, a)); }
SB_INLINE double ndli_component(ndli_v3 a, int i) { return i == 0 ? a.x : i == 1 ? a.y : a.z; }
SB_INLINE int ndli_is_finite(double x) { return x - x == 0; }

SB_INLINE ndli_m3 ndli_m_zero(void)
{
    ndli_m3 a;
    memset(&a, 0, sizeof a);
    return a;
}
/* *a += s b */
SB_INLINE void ndli_m_add(ndli_m3 *a, double s, const ndli_m3 *b)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            a->m[i][j] += s * b->m[i][j];
}
/* *a += s I */
SB_INLINE void ndli_m_add_identity(ndli_m3 *a, double s)
{
    for (int i = 0; i < 3; i++)
        a->m[i][i] += s;
}
/* *a += s u v^T */
SB_INLINE void ndli_m_add_outer(ndli_m3 *a, double s, ndli_v3 u, ndli_v3 v)
{
    ndli_v3 row[3];
    row[0] = ndli_scale(s * u.x, v);
    row[1] = ndli_scale(s * u.y, v);
    row[2] = ndli_scale(s * u.z, v);
    for (int i = 0; i < 3; i++) {
        a->m[i][0] += row[i].x;
        a->m[i][1] += row[i].y;
        a->m[i][2] += row[i].z;
    }
}
/* *a += s [u], with [u] w = u x w */
SB_INLINE void ndli_m_add_cross(ndli_m3 *a, double s, ndli_v3 u)
{
    a->m[0][1] -= s * u.z;
    a->m[0][2] += s * u.y;
    a->m[1][0] += s * u.z;
    a->m[1][2] -= s * u.x;
    a->m[2][0] -= s * u.y;
    a->m[2][1] += s * u.x;
}
SB_INLINE ndli_m3 ndli_m_transpose(const ndli_m3 *a)
{
    ndli_m3 r;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            r.m[i][j] = a->m[j][i];
    return r;
}
SB_INLINE ndli_m3 ndli_m_mul(const ndli_m3 *a, const ndli_m3 *b)
{
    ndli_m3 r;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            r.m[i][j] = a->m[i][0] * b->m[0][j] + a->m[i][1] * b->m[1][j] + a->m[i][2] * b->m[2][j];
    return r;
}
/* a^T b */
SB_INLINE ndli_m3 ndli_m_tmul(const ndli_m3 *a, const ndli_m3 *b)
{
    ndli_m3 r;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            r.m[i][j] = a->m[0][i] * b->m[0][j] + a->m[1][i] * b->m[1][j] + a->m[2][i] * b->m[2][j];
    return r;
}
SB_INLINE ndli_v3 ndli_m_apply(const ndli_m3 *a, ndli_v3 v)
{
    return ndli_v(a->m[0][0] * v.x + a->m[0][1] * v.y + a->m[0][2] * v.z,
                  a->m[1][0] * v.x + a->m[1][1] * v.y + a->m[1][2] * v.z,
                  a->m[2][0] * v.x + a->m[2][1] * v.y + a->m[2][2] * v.z);
}
/* a^T v */
SB_INLINE ndli_v3 ndli_m_tapply(const ndli_m3 *a, ndli_v3 v)
{
    return ndli_v(a->m[0][0] * v.x + a->m[1][0] * v.y + a->m[2][0] * v.z,
                  a->m[0][1] * v.x + a->m[1][1] * v.y + a->m[2][1] * v.z,
                  a->m[0][2] * v.x + a->m[1][2] * v.y + a->m[2][2] * v.z);
}
#endif

#endif /* NDL_REAL3_H */
