/* dense: 3-vectors, 3x3 matrices, quaternions, their decompositions, small dense systems, and scalar
 * functions that give the same bits everywhere. Floor 0. All static inline, public: needle.h and register.h
 * share them. Matrices are row-major, m[row][column]. All is thread-safe and allocates nothing. */
#ifndef SB_DENSE_H
#define SB_DENSE_H

#include <math.h>
#include <string.h>

#include "core.h"

/* Square roots by the processor's instruction: libm's has errno to set, and a test for that with a call behind it at
 * each of some 300 places. */
#if defined(__GNUC__) && defined(__SSE2_MATH__) && !defined(__NO_MATH_ERRNO__) && !defined(SB_NO_VECTORS)
#include <emmintrin.h>
#define SBI_SQRT_SSE2
#endif

typedef struct sb_vec3 {
    sb_real x, y, z;
} sb_vec3;

typedef struct sb_mat3 {
    sb_real m[3][3];
} sb_mat3;

/* Unit quaternion w + xi + yj + zk of a rotation. */
typedef struct sb_quat {
    sb_real w, x, y, z;
} sb_quat;

/* Scalar functions of libm in the precision of sb_real. sqrt is exactly rounded, so it is the same
 * everywhere; other libm functions are not and stay out of stepping code (see sb_log, sb_cbrt ... below). */
#if SB_REAL_IS_FLOAT
SB_INLINE sb_real sb_abs(sb_real x) { return fabsf(x); }
#else
SB_INLINE sb_real sb_abs(sb_real x) { return fabs(x); }
#endif
#if defined(SBI_SQRT_SSE2) && SB_REAL_IS_FLOAT
SB_INLINE sb_real sb_sqrt(sb_real x)
{
    __m128 v = {x, x, x, x};
    return _mm_cvtss_f32(_mm_sqrt_ss(v));
}
#elif defined(SBI_SQRT_SSE2)
SB_INLINE sb_real sb_sqrt(sb_real x)
{
    __m128d v = {x, x};
    return _mm_cvtsd_f64(_mm_sqrt_sd(v, v));
}
#elif SB_REAL_IS_FLOAT
SB_INLINE sb_real sb_sqrt(sb_real x) { return sqrtf(x); }
#else
SB_INLINE sb_real sb_sqrt(sb_real x) { return sqrt(x); }
#endif
#undef SBI_SQRT_SSE2
SB_INLINE sb_real sb_min(sb_real a, sb_real b) { return a < b ? a : b; }
SB_INLINE sb_real sb_max(sb_real a, sb_real b) { return a > b ? a : b; }
/* a b for a, b >= 0, at most SB_REAL_MAX and without the exception that an overflow raises. */
SB_INLINE sb_real sbi_capped_product(sb_real a, sb_real b)
{
    return a > 1 && b > SB_REAL_MAX / a ? SB_REAL_MAX : a * b;
}

/* ---- 3-vectors ---- */

SB_INLINE sb_vec3 sb_v3(sb_real x, sb_real y, sb_real z)
{
    sb_vec3 v;
    v.x = x;
    v.y = y;
    v.z = z;
    return v;
}
SB_INLINE sb_vec3 sb_v3_add(sb_vec3 a, sb_vec3 b) { return sb_v3(a.x + b.x, a.y + b.y, a.z + b.z); }
SB_INLINE sb_vec3 sb_v3_sub(sb_vec3 a, sb_vec3 b) { return sb_v3(a.x - b.x, a.y - b.y, a.z - b.z); }
SB_INLINE sb_vec3 sb_v3_scale(sb_real s, sb_vec3 a) { return sb_v3(s * a.x, s * a.y, s * a.z); }
/* a + s b */
SB_INLINE sb_vec3 sb_v3_madd(sb_vec3 a, sb_real s, sb_vec3 b)
{
    return sb_v3(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z);
}
SB_INLINE sb_real sb_v3_dot(sb_vec3 a, sb_vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
SB_INLINE sb_vec3 sb_v3_cross(sb_vec3 a, sb_vec3 b)
{
    return sb_v3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
SB_INLINE sb_real sb_v3_norm(sb_vec3 a) { return sb_sqrt(sb_v3_dot(a, a)); }
SB_INLINE int sb_v3_is_finite(sb_vec3 a) { return sb_is_finite(a.x) && sb_is_finite(a.y) && sb_is_finite(a.z); }

/* ---- 3x3 matrices ---- */

SB_INLINE sb_mat3 sb_m3_zero(void)
{
    sb_mat3 a;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            a.m[i][j] = 0;
    return a;
}
SB_INLINE sb_mat3 sb_m3_identity(void)
{
    sb_mat3 a = sb_m3_zero();
    a.m[0][0] = a.m[1][1] = a.m[2][2] = 1;
    return a;
}
/* Matrix with columns a, b, c. */
SB_INLINE sb_mat3 sb_m3_columns(sb_vec3 a, sb_vec3 b, sb_vec3 c)
{
    sb_mat3 r;
    r.m[0][0] = a.x, r.m[0][1] = b.x, r.m[0][2] = c.x;
    r.m[1][0] = a.y, r.m[1][1] = b.y, r.m[1][2] = c.y;
    r.m[2][0] = a.z, r.m[2][1] = b.z, r.m[2][2] = c.z;
    return r;
}
SB_INLINE sb_vec3 sb_m3_column(sb_mat3 a, int j) { return sb_v3(a.m[0][j], a.m[1][j], a.m[2][j]); }
SB_INLINE sb_mat3 sb_m3_add(sb_mat3 a, sb_mat3 b)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            a.m[i][j] += b.m[i][j];
    return a;
}
SB_INLINE sb_mat3 sb_m3_sub(sb_mat3 a, sb_mat3 b)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            a.m[i][j] -= b.m[i][j];
    return a;
}
SB_INLINE sb_mat3 sb_m3_scale(sb_real s, sb_mat3 a)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            a.m[i][j] *= s;
    return a;
}
SB_INLINE sb_mat3 sb_m3_transpose(sb_mat3 a)
{
    sb_mat3 r;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            r.m[i][j] = a.m[j][i];
    return r;
}
/* a b */
SB_INLINE sb_mat3 sb_m3_mul(sb_mat3 a, sb_mat3 b)
{
    sb_mat3 r;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            r.m[i][j] = a.m[i][0] * b.m[0][j] + a.m[i][1] * b.m[1][j] + a.m[i][2] * b.m[2][j];
    return r;
}
/* a^T b */
SB_INLINE sb_mat3 sb_m3_tmul(sb_mat3 a, sb_mat3 b)
{
    sb_mat3 r;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            r.m[i][j] = a.m[0][i] * b.m[0][j] + a.m[1][i] * b.m[1][j] + a.m[2][i] * b.m[2][j];
    return r;
}
/* a b^T */
SB_INLINE sb_mat3 sb_m3_mult(sb_mat3 a, sb_mat3 b)
{
    sb_mat3 r;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            r.m[i][j] = a.m[i][0] * b.m[j][0] + a.m[i][1] * b.m[j][1] + a.m[i][2] * b.m[j][2];
    return r;
}
/* a v */
SB_INLINE sb_vec3 sb_m3_apply(sb_mat3 a, sb_vec3 v)
{
    return sb_v3(a.m[0][0] * v.x + a.m[0][1] * v.y + a.m[0][2] * v.z,
                 a.m[1][0] * v.x + a.m[1][1] * v.y + a.m[1][2] * v.z,
                 a.m[2][0] * v.x + a.m[2][1] * v.y + a.m[2][2] * v.z);
}
/* a^T v */
SB_INLINE sb_vec3 sb_m3_tapply(sb_mat3 a, sb_vec3 v)
{
    return sb_v3(a.m[0][0] * v.x + a.m[1][0] * v.y + a.m[2][0] * v.z,
                 a.m[0][1] * v.x + a.m[1][1] * v.y + a.m[2][1] * v.z,
                 a.m[0][2] * v.x + a.m[1][2] * v.y + a.m[2][2] * v.z);
}
/* u v^T */
SB_INLINE sb_mat3 sb_m3_outer(sb_vec3 u, sb_vec3 v)
{
    return sb_m3_columns(sb_v3_scale(v.x, u), sb_v3_scale(v.y, u), sb_v3_scale(v.z, u));
}
SB_INLINE sb_real sb_m3_trace(sb_mat3 a) { return a.m[0][0] + a.m[1][1] + a.m[2][2]; }
/* A:B = sum A_ij B_ij */
SB_INLINE sb_real sb_m3_ddot(sb_mat3 a, sb_mat3 b)
{
    sb_real sum = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            sum += a.m[i][j] * b.m[i][j];
    return sum;
}
/* Cofactor matrix: columns f1 x f2, f2 x f0, f0 x f1 of the columns f; det(a) a^-T where that exists. */
SB_INLINE sb_mat3 sb_m3_cofactor(sb_mat3 a)
{
    sb_vec3 c0 = sb_m3_column(a, 0), c1 = sb_m3_column(a, 1), c2 = sb_m3_column(a, 2);
    return sb_m3_columns(sb_v3_cross(c1, c2), sb_v3_cross(c2, c0), sb_v3_cross(c0, c1));
}
SB_INLINE sb_real sb_m3_det(sb_mat3 a)
{
    return sb_v3_dot(sb_m3_column(a, 0), sb_v3_cross(sb_m3_column(a, 1), sb_m3_column(a, 2)));
}
/* Inverse; the caller makes sure that det(a) is not 0. */
SB_INLINE sb_mat3 sb_m3_inverse(sb_mat3 a)
{
    return sb_m3_scale((sb_real)1 / sb_m3_det(a), sb_m3_transpose(sb_m3_cofactor(a)));
}

/* ---- scalar functions with the same bits everywhere -------------------------------------------------------
 * libm's exp, log, sin ... differ between systems; these are built from + - * /, sqrt and moves of bits only,
 * so every compiler and -O level gives the same bits as long as it neither contracts a*b+c nor keeps extra
 * precision. All work in double, also in a float build (which therefore is rounded once, at the end). Errors
 * in double, in units in the last place (u.l.p.): below 0.9 for exp, log, cbrt, sin and cos, below 2.1 for
 * the others. */

SB_INLINE uint64_t sbi_dense_bits(double x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}
SB_INLINE double sbi_dense_from_bits(uint64_t bits)
{
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}
/* 2^n for -1022 <= n <= 1023 */
SB_INLINE double sbi_dense_pow2(int n) { return sbi_dense_from_bits((uint64_t)(n + 1023) << 52); }
/* Exponent n of a positive normal x = 2^n m, 1 <= m < 2. */
SB_INLINE int sbi_dense_exponent(double x) { return (int)(sbi_dense_bits(x) >> 52) - 1023; }

SB_INLINE double sbi_dense_exp(double x)
{
    double hi, lo, r, p;
    int n, half;
    if (x != x)
        return x;
    if (x > 709.7827128933841)
        return (double)INFINITY;
    if (x < -745.1332191019412)
        return 0.0;
    /* x = n ln 2 + r, |r| <= 0.35; n times the 40-bit head of ln 2 is exact */
    n = (int)(x * 1.4426950408889634 + (x < 0 ? -0.5 : 0.5));
    hi = x - n * 0.6931471805592082;
    lo = n * 7.371002565167799e-13;
    r = hi - lo;
    p = 1.0 / 479001600.0 + r * (1.0 / 6227020800.0);
    p = 1.0 / 3628800.0 + r * (1.0 / 39916800.0 + r * p);
    p = 1.0 / 40320.0 + r * (1.0 / 362880.0 + r * p);
    p = 1.0 / 720.0 + r * (1.0 / 5040.0 + r * p);
    p = 1.0 / 24.0 + r * (1.0 / 120.0 + r * p);
    p = r * r * (0.5 + r * (1.0 / 6.0 + r * p));
    /* 2^n in two factors: both are normal, and a subnormal result is rounded once */
    half = n / 2;
    return (1.0 + (hi - (lo - p))) * sbi_dense_pow2(half) * sbi_dense_pow2(n - half);
}

SB_INLINE double sbi_dense_log(double x)
{
    double f, s, z, r, half_square;
    int n = 0;
    if (!(x > 0))
        return x == 0 ? -(double)INFINITY : (double)NAN;
    if (x > 1.7976931348623157e308)
        return x;
    if (x < 2.2250738585072014e-308) {
        x *= 18014398509481984.0; /* 2^54 makes a subnormal normal */
        n = -54;
    }
    n += sbi_dense_exponent(x);
    x = sbi_dense_from_bits((sbi_dense_bits(x) & 0x000fffffffffffffULL) | 0x3ff0000000000000ULL);
    if (x > 1.4142135623730951) {
        x *= 0.5;
        n++;
    }
    /* x = 1 + f, s = f / (2 + f): log x = 2 atanh s = f - (f^2/2 - s (f^2/2 + r)), r = 2 s^2/3 + 2 s^4/5 +
     * ... */
    f = x - 1.0;
    s = f / (2.0 + f);
    z = s * s;
    r = 2.0 / 19.0 + z * (2.0 / 21.0 + z * (2.0 / 23.0));
    r = 2.0 / 13.0 + z * (2.0 / 15.0 + z * (2.0 / 17.0 + z * r));
    r = 2.0 / 7.0 + z * (2.0 / 9.0 + z * (2.0 / 11.0 + z * r));
    r = z * (2.0 / 3.0 + z * (2.0 / 5.0 + z * r));
    half_square = 0.5 * f * f;
    return n * 0.6931471805592082 - ((half_square - (s * (half_square + r) + n * 7.371002565167799e-13)) - f);
}

/* For positive finite x = m 2^(3k), 1 <= m < 8: *m, *k, and cbrt(m) to 26 bits, whose square is exact. */
SB_INLINE double sbi_dense_cbrt_head(double x, double *m, int *k)
{
    double y, t, cube;
    int n = 0, rest;
    if (x < 2.2250738585072014e-308) {
        x *= 18014398509481984.0;
        n = -54;
    }
    n += sbi_dense_exponent(x);
    *k = (n + 1200) / 3 - 400; /* floor(n / 3) */
    rest = n - 3 * *k;
    y = sbi_dense_from_bits((sbi_dense_bits(x) & 0x000fffffffffffffULL) | 0x3ff0000000000000ULL);
    *m = rest == 0 ? y : rest == 1 ? 2.0 * y : 4.0 * y;
    t = 0.6256872265641462 + y * (0.43356059182365925 - y * 0.05836172077613474); /* to 9e-4 on [1, 2] */
    t *= rest == 0 ? 1.0 : rest == 1 ? 1.259921049894873 : 1.5874010519681994;
    cube = t * t * t;
    t *= (cube + 2.0 * *m) / (2.0 * cube + *m); /* Halley: to 5e-10 */
    return sbi_dense_from_bits((sbi_dense_bits(t) + 0x4000000ULL) & ~0x7ffffffULL);
}

SB_INLINE double sbi_dense_cbrt(double x)
{
    double m, t, ratio, size = fabs(x);
    int k;
    if (x == 0 || !(size <= 1.7976931348623157e308))
        return x; /* 0, infinity, NaN */
    t = sbi_dense_cbrt_head(size, &m, &k);
    ratio = m / (t * t);
    t += t * ((ratio - t) / (2.0 * t + ratio));
    t *= sbi_dense_pow2(k);
    return x < 0 ? -t : t;
}

SB_INLINE double sbi_dense_pow_minus_two_thirds(double x)
{
    double m, t, d;
    int k;
    if (!(x > 0))
        return x == 0 ? (double)INFINITY : (double)NAN;
    if (x > 1.7976931348623157e308)
        return 0.0;
    t = sbi_dense_cbrt_head(x, &m, &k);
    /* m = t^3 (1 + d): m^(-2/3) = t^-2 (1 - 2d/3 + 5d^2/9 ...), |d| < 3e-8 */
    d = (m / (t * t) - t) / t;
    return (1.0 - d * (2.0 / 3.0 - d * (5.0 / 9.0))) / (t * t) * sbi_dense_pow2(-2 * k);
}

SB_INLINE void sbi_dense_sin_cos(double x, double *s, double *c)
{
    double r, w, t, tail, y, low, z, p, half, sine, cosine;
    int n;
    if (!(fabs(x) <= 1.7976931348623157e308)) {
        *s = *c = (double)NAN;
        return;
    }
    if (fabs(x) > 1.0e6)
        x = fmod(x, 6.283185307179586); /* fmod is exact, so it is the same everywhere */
    /* x = n pi/2 + y + low; n times the two 33-bit heads of pi/2 is exact */
    n = (int)(x * 0.6366197723675814 + (x < 0 ? -0.5 : 0.5));
    t = x - n * 1.5707963267341256;
    w = n * 6.077100506303966e-11;
    r = t - w;
    tail = n * 2.0222662487959506e-21 - ((t - r) - w);
    y = r - tail;
    low = (r - y) - tail;
    z = y * y;
    p = -1.0 / 1307674368000.0 + z * (1.0 / 355687428096000.0);
    p = 1.0 / 362880.0 + z * (-1.0 / 39916800.0 + z * (1.0 / 6227020800.0 + z * p));
    p = -1.0 / 6.0 + z * (1.0 / 120.0 + z * (-1.0 / 5040.0 + z * p));
    sine = y + (y * z * p + low * (1.0 - 0.5 * z));
    p = -1.0 / 87178291200.0 + z * (1.0 / 20922789888000.0);
    p = -1.0 / 3628800.0 + z * (1.0 / 479001600.0 + z * p);
    p = 1.0 / 24.0 + z * (-1.0 / 720.0 + z * (1.0 / 40320.0 + z * p));
    half = 0.5 * z;
    w = 1.0 - half;
    cosine = w + (((1.0 - w) - half) + (z * z * p - y * low));
    *s = n & 1 ? cosine : sine;
    *c = n & 1 ? sine : cosine;
    if (n & 2)
        *s = -*s;
    if ((n + 1) & 2)
        *c = -*c;
}

/* atan(small / large), 0 <= small <= large, large > 0, both finite and of moderate size. */
SB_INLINE double sbi_dense_atan_octant(double small, double large)
{
    static const double table[9][2] = {/* atan(k / 8), and what its rounding left */
                                       {0.0, 0.0},
                                       {0.12435499454676144, -3.1253241424539383e-18},
                                       {0.24497866312686414, 1.0698755618734451e-17},
                                       {0.35877067027057225, -2.4623815582638635e-17},
                                       {0.4636476090008061, 2.2698777452961687e-17},
                                       {0.5585993153435624, -5.4556305485916264e-18},
                                       {0.6435011087932844, 1.5834785051444286e-17},
                                       {0.7188299996216245, -2.1478388444456983e-17},
                                       {0.7853981633974483, 3.061616997868383e-17}};
    int k = (int)(8.0 * (small / large) + 0.5);
    double c = 0.125 * k; /* atan(y/x) = atan(c) + atan((y - c x)/(x + c y)); the last argument is <= 1/16 */
    double u = (small - c * large) / (large + c * small), z = u * u, p;
    p = 1.0 / 9.0 + z * (-1.0 / 11.0 + z * (1.0 / 13.0 - z * (1.0 / 15.0)));
    p = -1.0 / 3.0 + z * (1.0 / 5.0 + z * (-1.0 / 7.0 + z * p));
    return table[k][0] + (u + (u * z * p + table[k][1]));
}

SB_INLINE double sbi_dense_atan2(double y, double x)
{
    double small = fabs(y), large = fabs(x), angle, scale;
    int steep = small > large;
    if (x != x || y != y)
        return (double)NAN;
    if (steep) {
        double swap = small;
        small = large;
        large = swap;
    }
    if (large == 0) {
        angle = 0.0;
    } else if (large > 1.7976931348623157e308) {
        angle = small > 1.7976931348623157e308 ? 0.7853981633974483 : 0.0;
    } else {
        scale = large > 1.0e150 ? sbi_dense_pow2(-600) : large < 1.0e-150 ? sbi_dense_pow2(600) : 1.0;
        small *= scale;
        large *= scale;
        angle = sbi_dense_atan_octant(small, large);
    }
    /* pi and pi/2 in two parts */
    if (steep)
        angle = 1.5707963267948966 - (angle - 6.123233995736766e-17);
    if (copysign(1.0, x) < 0)
        angle = 3.141592653589793 - (angle - 1.2246467991473532e-16);
    return copysign(angle, y);
}

/* e^x. Above 709.78 (float: 88.72) infinity, below -745.1 (-103.9) 0, subnormal results in between; NaN for
 * NaN. */
SB_INLINE sb_real sb_exp(sb_real x) { return (sb_real)sbi_dense_exp((double)x); }
/* Natural logarithm. -infinity for 0, NaN for x < 0 and for NaN. */
SB_INLINE sb_real sb_log(sb_real x) { return (sb_real)sbi_dense_log((double)x); }
/* Cube root, for every finite x; odd; infinity, NaN and the sign of 0 pass through. Exact for exact cubes. */
SB_INLINE sb_real sb_cbrt(sb_real x) { return (sb_real)sbi_dense_cbrt((double)x); }
/* x^(-2/3), the isochoric scale J^(-2/3) of a volume ratio x > 0. Infinity for 0; NaN for x < 0 and NaN. */
SB_INLINE sb_real sb_pow_minus_two_thirds(sb_real x) { return (sb_real)sbi_dense_pow_minus_two_thirds((double)x); }
/* Sine and cosine of x [rad]. Above 1e6 rad they are those of an x changed by less than half its own u.l.p.
 * (2 pi is rounded there). NaN for NaN and infinity. */
SB_INLINE void sb_sin_cos(sb_real x, sb_real *s, sb_real *c)
{
    double sine, cosine;
    sbi_dense_sin_cos((double)x, &sine, &cosine);
    *s = (sb_real)sine;
    *c = (sb_real)cosine;
}
/* Angle of the point (x, y), in [-pi, pi], with atan2's signs; 0 or pi for the origin, after the signs of the
 * zeros; NaN for NaN. */
SB_INLINE sb_real sb_atan2(sb_real y, sb_real x) { return (sb_real)sbi_dense_atan2((double)y, (double)x); }
/* Angle in [0, pi] whose cosine is x; NaN outside [-1, 1]. */
SB_INLINE sb_real sb_acos(sb_real x)
{
    double c = (double)x;
    return (sb_real)sbi_dense_atan2(sqrt((1.0 - c) * (1.0 + c)), c);
}

/* ---- quaternions of rotations ---- */

SB_INLINE sb_quat sb_quat_make(sb_real w, sb_real x, sb_real y, sb_real z)
{
    sb_quat q;
    q.w = w;
    q.x = x;
    q.y = y;
    q.z = z;
    return q;
}
SB_INLINE sb_quat sb_quat_identity(void) { return sb_quat_make(1, 0, 0, 0); }
/* The inverse rotation of a unit q. */
SB_INLINE sb_quat sb_quat_conjugate(sb_quat q) { return sb_quat_make(q.w, -q.x, -q.y, -q.z); }
SB_INLINE sb_real sb_quat_dot(sb_quat a, sb_quat b) { return a.w * b.w + a.x * b.x + a.y * b.y + a.z * b.z; }
/* a b: the rotation b followed by the rotation a. The order of the products avoids - and + in turn from
 * entry to entry: there gcc 12 fuses multiply and add even under -ffp-contract=off (its vfmaddsub). */
SB_INLINE sb_quat sb_quat_mul(sb_quat a, sb_quat b)
{
    sb_quat r;
    r.w = a.w * b.w - (a.x * b.x + a.y * b.y + a.z * b.z);
    r.x = a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y;
    r.y = a.w * b.y + a.y * b.w + a.z * b.x - a.x * b.z;
    r.z = a.w * b.z + a.z * b.w + a.x * b.y - a.y * b.x;
    return r;
}
/* q / |q|; the identity when q is zero or not finite. */
SB_INLINE sb_quat sb_quat_normalise(sb_quat q)
{
    sb_real size = sb_max(sb_max(sb_abs(q.w), sb_abs(q.x)), sb_max(sb_abs(q.y), sb_abs(q.z))), n, scale;
    if (!(size > 0))
        return sb_quat_identity();
    q = sb_quat_make(q.w / size, q.x / size, q.y / size, q.z / size); /* squares stay in range */
    n = sb_quat_dot(q, q);
    if (!(n > 0)) /* an entry was NaN or infinite */
        return sb_quat_identity();
    scale = (sb_real)1 / sb_sqrt(n);
    return sb_quat_make(scale * q.w, scale * q.x, scale * q.y, scale * q.z);
}
/* Rotation by |v| rad about v (the exponential map); the identity for v = 0. */
SB_INLINE sb_quat sb_quat_from_rotation_vector(sb_vec3 v)
{
    sb_real angle = sb_v3_norm(v), s, c, factor;
    sb_sin_cos((sb_real)0.5 * angle, &s, &c);
    factor = angle > 0 ? s / angle : (sb_real)0.5;
    return sb_quat_make(c, factor * v.x, factor * v.y, factor * v.z);
}
/* |q|^2 times the rotation matrix of q: no division, and exact zeros stay zeros. */
SBI_FORCE_INLINE sb_mat3 sbi_quat_to_scaled_mat3(sb_quat q)
{
    sb_real ww = q.w * q.w, xx = q.x * q.x, yy = q.y * q.y, zz = q.z * q.z;
    sb_real xy = q.x * q.y, xz = q.x * q.z, yz = q.y * q.z;
    sb_real on = 2 * q.w, back = -2 * q.w; /* sums only: no - and + in turn, as in sb_quat_mul */
    sb_real sum = ww + xx, difference = ww - xx;
    sb_mat3 r;
    xy += xy, xz += xz, yz += yz;
    r.m[0][0] = sum - (yy + zz), r.m[0][1] = xy + back * q.z, r.m[0][2] = xz + on * q.y;
    r.m[1][0] = xy + on * q.z, r.m[1][1] = difference + (yy - zz), r.m[1][2] = yz + back * q.x;
    r.m[2][0] = xz + back * q.y, r.m[2][1] = yz + on * q.x, r.m[2][2] = difference + (zz - yy);
    return r;
}
/* Rotation matrix of a unit quaternion. */
SB_INLINE sb_mat3 sb_quat_to_mat3(sb_quat q) { return sbi_quat_to_scaled_mat3(q); }
/* Unit quaternion, w >= 0, of a rotation matrix (Shepperd 1978: the largest component first, so no
 * cancellation). */
SB_INLINE sb_quat sb_quat_from_mat3(sb_mat3 r)
{
    sb_real trace = sb_m3_trace(r);
    sb_quat q;
    if (trace >= r.m[0][0] && trace >= r.m[1][1] && trace >= r.m[2][2])
        q = sb_quat_make(1 + trace, r.m[2][1] - r.m[1][2], r.m[0][2] - r.m[2][0], r.m[1][0] - r.m[0][1]);
    else if (r.m[0][0] >= r.m[1][1] && r.m[0][0] >= r.m[2][2])
        q = sb_quat_make(r.m[2][1] - r.m[1][2], 1 + r.m[0][0] - r.m[1][1] - r.m[2][2], r.m[0][1] + r.m[1][0],
                         r.m[0][2] + r.m[2][0]);
    else if (r.m[1][1] >= r.m[2][2])
        q = sb_quat_make(r.m[0][2] - r.m[2][0], r.m[0][1] + r.m[1][0], 1 + r.m[1][1] - r.m[0][0] - r.m[2][2],
                         r.m[1][2] + r.m[2][1]);
    else
        q = sb_quat_make(r.m[1][0] - r.m[0][1], r.m[0][2] + r.m[2][0], r.m[1][2] + r.m[2][1],
                         1 + r.m[2][2] - r.m[0][0] - r.m[1][1]);
    q = sb_quat_normalise(q);
    return q.w < 0 ? sb_quat_make(-q.w, -q.x, -q.y, -q.z) : q;
}
/* v rotated by the unit quaternion q. */
SB_INLINE sb_vec3 sb_quat_rotate(sb_quat q, sb_vec3 v)
{
    sb_vec3 u = sb_v3(q.x, q.y, q.z), t = sb_v3_cross(u, v);
    t = sb_v3_add(t, t);
    return sb_v3_add(sb_v3_madd(v, q.w, t), sb_v3_cross(u, t));
}

/* ---- symmetric eigenvalues, singular values ---- */

/* Largest |entry|, or NaN when an entry is not finite. */
SB_INLINE sb_real sbi_dense_max_abs(const sb_real *a, int count)
{
    sb_real largest = 0, zero = 0;
    for (int i = 0; i < count; i++) {
        largest = sb_max(sb_abs(a[i]), largest);
        zero += a[i] - a[i];
    }
    return largest + zero;
}

/* Power of two s for which s * size is near 1, and 1 / s, both exact. */
SB_INLINE void sbi_dense_scale(sb_real size, sb_real *scale, sb_real *inverse)
{
    int n = (double)size < 2.2250738585072014e-308 ? -1022 : sbi_dense_exponent((double)size);
    int limit = SB_REAL_IS_FLOAT ? 120 : 1020;
    n = n > limit ? limit : n < -limit ? -limit : n;
    *scale = (sb_real)sbi_dense_pow2(-n);
    *inverse = (sb_real)sbi_dense_pow2(n);
}

/* Tangent of the angle of the Jacobi rotation that makes [[a, b], [b, d]] diagonal, b != 0, |angle| <= 45
 * deg. */
SB_INLINE sb_real sbi_dense_jacobi_tangent(sb_real a, sb_real b, sb_real d)
{
    const sb_real most =
        SB_REAL_IS_FLOAT ? (sb_real)1.844674e19 : (sb_real)1.3407807929942596e154; /* root of SB_REAL_MAX */
    sb_real theta = (d - a) / (b + b);
    sb_real t = sb_abs(theta) < most ? (sb_real)1 / (sb_abs(theta) + sb_sqrt(theta * theta + 1)) : 0;
    return theta < 0 ? -t : t;
}

/* Is the off-diagonal g of a 2x2 block with the diagonal a, d large enough to rotate away? Relative to the
 * diagonal, so that graded matrices keep their small eigenvalues; entries are scaled to 1. */
SB_INLINE int sbi_dense_jacobi_needed(sb_real a, sb_real g, sb_real d)
{
    const sb_real least = SB_EPSILON * SB_EPSILON * SB_EPSILON;
    g = sb_abs(g);
    return g > least && g > (sb_real)0.25 * SB_EPSILON * sb_sqrt(sb_abs(a)) * sb_sqrt(sb_abs(d));
}

/* Cyclic Jacobi on the n x n symmetric a (entries up to about 1): eigenvalues on its diagonal, eigenvectors
 * in the columns of v. At most 20 sweeps (4 to 6 are usual). */
SBI_FORCE_INLINE void sbi_dense_jacobi(sb_real *a, sb_real *v, int n)
{
    for (int i = 0; i < n * n; i++)
        v[i] = i % (n + 1) == 0 ? (sb_real)1 : (sb_real)0;
    for (int sweep = 0, rotated = 1; rotated && sweep < 20; sweep++) {
        rotated = 0;
        for (int p = 0; p < n - 1; p++)
            for (int q = p + 1; q < n; q++) {
                sb_real g = a[p * n + q], t, c, s;
                if (!sbi_dense_jacobi_needed(a[p * n + p], g, a[q * n + q]))
                    continue;
                rotated = 1;
                t = sbi_dense_jacobi_tangent(a[p * n + p], g, a[q * n + q]);
                c = (sb_real)1 / sb_sqrt(t * t + 1);
                s = t * c;
                a[p * n + p] -= t * g;
                a[q * n + q] += t * g;
                a[p * n + q] = a[q * n + p] = 0;
                for (int k = 0; k < n; k++) {
                    sb_real vp = v[k * n + p], vq = v[k * n + q];
                    v[k * n + p] = c * vp - s * vq;
                    v[k * n + q] = s * vp + c * vq;
                    if (k != p && k != q) {
                        sb_real ap = a[k * n + p], aq = a[k * n + q];
                        a[k * n + p] = a[p * n + k] = c * ap - s * aq;
                        a[k * n + q] = a[q * n + k] = s * ap + c * aq;
                    }
                }
            }
    }
}

/* Eigenvalues, descending (x >= y >= z), and orthonormal eigenvectors of a symmetric a: a = V diag(values)
 * V^T, det V = +1, column j of *vectors belongs to value j. Reads the upper triangle of a. Errors are a few
 * u.l.p. of the largest |value|. For a not finite: values NaN, vectors the identity. Either output may be
 * NULL. */
SB_INLINE void sb_m3_eigen(sb_mat3 a, sb_vec3 *values, sb_mat3 *vectors)
{
    sb_real m[9], v[9], d[3], scale, inverse, size;
    int order[3] = {0, 1, 2};
    sb_mat3 basis = sb_m3_identity();
    for (int i = 0; i < 9; i++)
        m[i] = i / 3 <= i % 3 ? a.m[i / 3][i % 3] : a.m[i % 3][i / 3];
    size = sbi_dense_max_abs(m, 9);
    if (!(size > 0)) { /* zero or NaN: size itself is the answer */
        if (values)
            *values = sb_v3(size, size, size);
        if (vectors)
            *vectors = basis;
        return;
    }
    sbi_dense_scale(size, &scale, &inverse);
    for (int i = 0; i < 9; i++)
        m[i] *= scale;
    sbi_dense_jacobi(m, v, 3);
    for (int i = 0; i < 3; i++)
        d[i] = m[4 * i];
    for (int pass = 0; pass < 3; pass++) {
        int i = pass % 2;
        if (d[order[i]] < d[order[i + 1]]) {
            int swap = order[i];
            order[i] = order[i + 1];
            order[i + 1] = swap;
        }
    }
    for (int j = 0; j < 3; j++)
        for (int i = 0; i < 3; i++)
            basis.m[i][j] = v[3 * i + order[j]];
    if (sb_m3_det(basis) < 0)
        for (int i = 0; i < 3; i++)
            basis.m[i][2] = -basis.m[i][2];
    if (values)
        *values = sb_v3(d[order[0]] * inverse, d[order[1]] * inverse, d[order[2]] * inverse);
    if (vectors)
        *vectors = basis;
}

/* A unit vector at right angles to the unit vector a. */
SB_INLINE sb_vec3 sb_v3_perpendicular(sb_vec3 a)
{
    sb_vec3 axis = sb_abs(a.x) < (sb_real)0.6 ? sb_v3(1, 0, 0) : sb_v3(0, 1, 0), b = sb_v3_cross(a, axis);
    return sb_v3_scale((sb_real)1 / sb_v3_norm(b), b);
}

/* One-sided Jacobi (Hestenes): turns pairs of columns of b and v until the columns of b are at right angles,
 * each pair to rounding relative to its own lengths. At most 20 sweeps. */
SB_INLINE void sbi_dense_orthogonalise(sb_vec3 b[3], sb_vec3 v[3])
{
    for (int sweep = 0, rotated = 1; rotated && sweep < 20; sweep++) {
        rotated = 0;
        for (int p = 0; p < 2; p++)
            for (int q = p + 1; q < 3; q++) {
                sb_real alpha = sb_v3_dot(b[p], b[p]), gamma = sb_v3_dot(b[p], b[q]), beta = sb_v3_dot(b[q], b[q]);
                sb_vec3 bp = b[p], vp = v[p];
                sb_real t, c, s;
                if (!(sb_abs(gamma) > SB_EPSILON * sb_sqrt(alpha) * sb_sqrt(beta)))
                    continue;
                rotated = 1;
                t = sbi_dense_jacobi_tangent(alpha, gamma, beta);
                c = (sb_real)1 / sb_sqrt(t * t + 1);
                s = t * c;
                b[p] = sb_v3_madd(sb_v3_scale(c, bp), -s, b[q]);
                b[q] = sb_v3_madd(sb_v3_scale(s, bp), c, b[q]);
                v[p] = sb_v3_madd(sb_v3_scale(c, vp), -s, v[q]);
                v[q] = sb_v3_madd(sb_v3_scale(s, vp), c, v[q]);
            }
    }
}

/* Left singular vectors from the orthogonal columns b (lengths n, descending): orthonormal, det +1, also
 * where a length is 0 or so small that its direction is noise. */
SB_INLINE sb_mat3 sbi_dense_left_vectors(const sb_vec3 b[3], const sb_real n[3])
{
    sb_vec3 u0 = sb_v3(1, 0, 0), u1 = u0;
    sb_real left = 0;
    if (n[0] > 0)
        u0 = sb_v3_scale((sb_real)1 / n[0], b[0]);
    u0 = sb_v3_scale((sb_real)1 / sb_v3_norm(u0), u0);
    if (n[1] > 0) {
        u1 = sb_v3_scale((sb_real)1 / n[1], b[1]);
        u1 = sb_v3_madd(u1, -sb_v3_dot(u0, u1), u0);
        left = sb_v3_norm(u1);
    }
    u1 = left > (sb_real)0.5 ? sb_v3_scale((sb_real)1 / left, u1) : sb_v3_perpendicular(u0);
    return sb_m3_columns(u0, u1, sb_v3_cross(u0, u1));
}

/* Length of a vector whose entries may be so small that their squares vanish. */
SB_INLINE sb_real sbi_dense_safe_norm(sb_vec3 a)
{
    sb_real size = sb_max(sb_abs(a.x), sb_max(sb_abs(a.y), sb_abs(a.z)));
    return size > 0 ? size * sb_v3_norm(sb_v3(a.x / size, a.y / size, a.z / size)) : 0;
}

/* Singular values with signs: f = U diag(s) V^T, det U = det V = +1, s.x >= s.y >= |s.z|, and s.z has the
 * sign of det f (Irving, Teran, Fedkiw 2004). Works for every rank, repeated values and every scale; small
 * singular values keep their relative accuracy as far as the columns of f allow. For f not finite: s NaN, U =
 * V = identity. One-sided Jacobi, no f^T f. Outputs may be NULL. */
SB_INLINE void sb_m3_svd(sb_mat3 f, sb_mat3 *u, sb_vec3 *s, sb_mat3 *v)
{
    sb_mat3 left = sb_m3_identity(), right = left;
    sb_real size = sbi_dense_max_abs(&f.m[0][0], 9), scale, inverse;
    sb_vec3 value = sb_v3(size, size, size);
    if (size > 0) {
        sb_vec3 b[3], w[3];
        sb_real n[3];
        sbi_dense_scale(size, &scale, &inverse);
        for (int j = 0; j < 3; j++) {
            b[j] = sb_v3_scale(scale, sb_m3_column(f, j));
            w[j] = sb_m3_column(right, j);
        }
        sbi_dense_orthogonalise(b, w);
        for (int j = 0; j < 3; j++)
            n[j] = sbi_dense_safe_norm(b[j]);
        for (int pass = 0; pass < 3; pass++) {
            int i = pass % 2;
            if (n[i] < n[i + 1]) { /* a swap with one sign change keeps det V = +1 */
                sb_vec3 swap = b[i];
                sb_real length = n[i];
                b[i] = b[i + 1], n[i] = n[i + 1];
                b[i + 1] = sb_v3_scale(-1, swap), n[i + 1] = length;
                swap = w[i];
                w[i] = w[i + 1];
                w[i + 1] = sb_v3_scale(-1, swap);
            }
        }
        left = sbi_dense_left_vectors(b, n);
        right = sb_m3_columns(w[0], w[1], w[2]);
        if (sb_v3_dot(sb_m3_column(left, 2), b[2]) < 0)
            n[2] = -n[2];
        value = sb_v3(n[0] * inverse, n[1] * inverse, n[2] * inverse);
    }
    if (u)
        *u = left;
    if (s)
        *s = value;
    if (v)
        *v = right;
}

/* ---- rotation of a deformation gradient ------------------------------------------------------------------
 * The rotation R that maximises tr(R^T F): the polar rotation for det F > 0 and its continuation with det R =
 * +1 for inverted F. With B = R^T F at the present R, a = (B21-B12, B02-B20, B10-B01) and H = tr(B) I -
 * sym(B), the quaternion (1, u) that turns R into the maximiser solves the eigenproblem (2H + (a.u) I) u = a.
 * Its first approximation u = H^-1 a / 2 is Newton's step; putting a.u back costs a fraction of a step and
 * gains two orders each time. H is positive definite only near the maximum, and no other stationary rotation
 * has such an H. (Compare Kugelstadt, Koschier, Bender 2018, who take the Newton step alone.) */

#define SBI_POLAR_STEPS 4 /* steps before a matrix counts as hard */
#if SB_REAL_IS_FLOAT
#define SBI_POLAR_LAST 8e-13f      /* square of a last correction that leaves an error below rounding */
#define SBI_POLAR_DEFINITE 3.5e-4f /* least det H / (tr H)^3 a Newton step is taken at: sqrt(SB_EPSILON) */
#define SBI_POLAR_LEAST 1e-9f      /* tr H outside these bounds: F must be scaled first, for det H's sake */
#define SBI_POLAR_MOST 1e9f
#else
#define SBI_POLAR_LAST 9e-26
#define SBI_POLAR_DEFINITE 1.5e-8
#define SBI_POLAR_LEAST 1e-60
#define SBI_POLAR_MOST 1e60
#endif

/* The next approximation of u after x: x0 - (a.x) (2H)^-1 x, with x0 = (2H)^-1 a and (2H)^-1 = inverse c. */
SBI_FORCE_INLINE sb_vec3 sbi_polar_correct(sb_vec3 x, sb_vec3 x0, sb_vec3 a, sb_mat3 c, sb_real inverse)
{
    return sb_v3_madd(x0, -(sb_v3_dot(a, x) * inverse), sb_m3_apply(c, x));
}

/* Step at q: *u, and *last = the square of its last correction. Returns 1, or 0 when H is not safely positive
 * definite, u is too long for its series, or F is out of range or not finite (then *u means nothing). |q|
 * need not be exactly 1: u does not depend on it. No branches and no loops, so that lanes of it vectorise. */
SBI_FORCE_INLINE int sbi_polar_newton(sb_mat3 f, sb_quat q, sb_vec3 *u, sb_real *last)
{
    sb_mat3 r = sbi_quat_to_scaled_mat3(q);
    sb_real b00 = r.m[0][0] * f.m[0][0] + r.m[1][0] * f.m[1][0] + r.m[2][0] * f.m[2][0];
    sb_real b01 = r.m[0][0] * f.m[0][1] + r.m[1][0] * f.m[1][1] + r.m[2][0] * f.m[2][1];
    sb_real b02 = r.m[0][0] * f.m[0][2] + r.m[1][0] * f.m[1][2] + r.m[2][0] * f.m[2][2];
    sb_real b10 = r.m[0][1] * f.m[0][0] + r.m[1][1] * f.m[1][0] + r.m[2][1] * f.m[2][0];
    sb_real b11 = r.m[0][1] * f.m[0][1] + r.m[1][1] * f.m[1][1] + r.m[2][1] * f.m[2][1];
    sb_real b12 = r.m[0][1] * f.m[0][2] + r.m[1][1] * f.m[1][2] + r.m[2][1] * f.m[2][2];
    sb_real b20 = r.m[0][2] * f.m[0][0] + r.m[1][2] * f.m[1][0] + r.m[2][2] * f.m[2][0];
    sb_real b21 = r.m[0][2] * f.m[0][1] + r.m[1][2] * f.m[1][1] + r.m[2][2] * f.m[2][1];
    sb_real b22 = r.m[0][2] * f.m[0][2] + r.m[1][2] * f.m[1][2] + r.m[2][2] * f.m[2][2];
    sb_real ax = b21 - b12, ay = b02 - b20, az = b10 - b01;
    /* g = 2H and its adjugate c */
    sb_real g00 = (b11 + b22) + (b11 + b22), g11 = (b00 + b22) + (b00 + b22), g22 = (b00 + b11) + (b00 + b11);
    sb_real g01 = -(b01 + b10), g02 = -(b02 + b20), g12 = -(b12 + b21);
    sb_real c00 = g11 * g22 - g12 * g12, c01 = g12 * g02 - g01 * g22, c02 = g01 * g12 - g11 * g02;
    sb_real c11 = g00 * g22 - g02 * g02, c12 = g01 * g02 - g00 * g12, c22 = g00 * g11 - g01 * g01;
    sb_real det = g00 * c00 + g01 * c01 + g02 * c02, trace = g00 + g11 + g22;
    sb_real size = sb_abs(g00) + sb_abs(g11) + sb_abs(g22) + sb_abs(g01) + sb_abs(g02) + sb_abs(g12) + sb_abs(ax) +
                   sb_abs(ay) + sb_abs(az) + SBI_POLAR_LEAST;
    /* No lane divides by zero. A maximum, since compilers turn conditions into branches. It is det wherever the step is
     * taken: a definite H has size <= 2 trace + |a|_1, and a step with |a|_1 > 2 trace is too long. */
    sb_real divisor = sb_max(det, SBI_POLAR_DEFINITE / 64 * (size * size * size)), inverse = (sb_real)1 / divisor;
    sb_mat3 c = sb_m3_columns(sb_v3(c00, c01, c02), sb_v3(c01, c11, c12), sb_v3(c02, c12, c22));
    sb_vec3 a = sb_v3(ax, ay, az), first = sb_v3_scale(inverse, sb_m3_apply(c, a)), before, change;
    before = sbi_polar_correct(first, first, a, c, inverse);
    before = sbi_polar_correct(before, first, a, c, inverse);
    *u = sbi_polar_correct(before, first, a, c, inverse);
    change = sb_v3_sub(*u, before);
    *last = sb_v3_dot(change, change);
    return (det > SBI_POLAR_DEFINITE * (trace * trace * trace)) & (det >= divisor) & (g00 > 0) & (c22 > 0) &
           (trace > SBI_POLAR_LEAST) & (trace < SBI_POLAR_MOST) & (sb_v3_dot(first, first) < (sb_real)0.25);
}

/* q (1, u) for |u| <= 0.6: the rotation q and then the step. The length stays within a few per cent of |q|
 * and is put right at the end. */
SBI_FORCE_INLINE sb_quat sbi_polar_turn(sb_quat q, sb_vec3 u)
{
    sb_real n = u.x * u.x + u.y * u.y + u.z * u.z;
    sb_real scale = 1 - n * ((sb_real)0.5 - (sb_real)0.375 * n); /* near 1 / |(1, u)| */
    return sb_quat_mul(q, sb_quat_make(scale, scale * u.x, scale * u.y, scale * u.z));
}

/* The maximiser nearest to `start` from the 4x4 eigenproblem tr(R(q)^T F) = q^T K q (Davenport): always
 * works, F scaled to about 1. Eigenvectors whose values agree to rounding are one space: there R is not
 * unique. */
SB_INLINE sb_quat sbi_polar_davenport(sb_mat3 f, sb_quat start)
{
    sb_real k[16], v[16], best, tie, along, q[4] = {0, 0, 0, 0}, s[4];
    int top = 0;
    k[0] = f.m[0][0] + f.m[1][1] + f.m[2][2];
    k[5] = f.m[0][0] - f.m[1][1] - f.m[2][2];
    k[10] = f.m[1][1] - f.m[0][0] - f.m[2][2];
    k[15] = f.m[2][2] - f.m[0][0] - f.m[1][1];
    k[1] = k[4] = f.m[2][1] - f.m[1][2];
    k[2] = k[8] = f.m[0][2] - f.m[2][0];
    k[3] = k[12] = f.m[1][0] - f.m[0][1];
    k[6] = k[9] = f.m[0][1] + f.m[1][0];
    k[7] = k[13] = f.m[0][2] + f.m[2][0];
    k[11] = k[14] = f.m[1][2] + f.m[2][1];
    tie = 16 * SB_EPSILON * sbi_dense_max_abs(k, 16);
    sbi_dense_jacobi(k, v, 4);
    for (int j = 1; j < 4; j++)
        top = k[5 * j] > k[5 * top] ? j : top;
    best = k[5 * top];
    s[0] = start.w, s[1] = start.x, s[2] = start.y, s[3] = start.z;
    for (int j = 0; j < 4; j++)
        if (k[5 * j] >= best - tie) {
            along = s[0] * v[j] + s[1] * v[4 + j] + s[2] * v[8 + j] + s[3] * v[12 + j];
            for (int i = 0; i < 4; i++)
                q[i] += along * v[4 * i + j];
        }
    if (!(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3] > SB_EPSILON))
        for (int i = 0; i < 4; i++) /* start is at right angles to every maximiser: any of them will do */
            q[i] = v[4 * i + top];
    return sb_quat_normalise(sb_quat_make(q[0], q[1], q[2], q[3]));
}

/* The general case: any scale, any start. Newton where H allows it, else the step of Mueller et al. 2016;
 * after that, or where H is singular at the maximum itself, the eigenproblem. */
SB_INLINE sb_quat sbi_polar_hard(sb_mat3 f, sb_quat start)
{
    sb_real size = sbi_dense_max_abs(&f.m[0][0], 9), scale, inverse;
    sb_quat q = start;
    if (!(size > 0))
        return start;
    sbi_dense_scale(size, &scale, &inverse);
    f = sb_m3_scale(scale, f);
    for (int step = 0, rough = 0; step < 12 && rough < 4; step++) {
        sb_vec3 w;
        sb_real last, w2;
        int newton = sbi_polar_newton(f, q, &w, &last);
        if (newton) {
            q = sb_quat_normalise(sbi_polar_turn(q, w));
            if (last < SBI_POLAR_LAST)
                return q;
        } else {
            sb_mat3 b = sb_m3_tmul(sb_quat_to_mat3(q), f);
            sb_real trace = sb_abs(sb_m3_trace(b)) + (sb_real)0.01;
            w = sb_v3((b.m[2][1] - b.m[1][2]) / trace, (b.m[0][2] - b.m[2][0]) / trace,
                      (b.m[1][0] - b.m[0][1]) / trace);
            w2 = sb_v3_dot(w, w);
            if (w2 < (sb_real)1e-4)
                break; /* a stationary point or nearly so: Newton will not take over soon */
            q = sb_quat_normalise(sb_quat_mul(q, sb_quat_make(1 + sb_sqrt(1 + w2), w.x, w.y, w.z)));
            rough++;
        }
    }
    return sbi_polar_davenport(f, start);
}

/* Unit quaternion of the rotation R that maximises tr(R^T f); R = sb_quat_to_mat3(result), S = R^T f. f: any
 * finite matrix, also inverted or singular; where the maximiser is not unique, one near `start`. start: unit
 * quaternion, best the result of the last step (the sign of the result follows it). Zero or non-finite f:
 * start. Errors: a few u.l.p. times |f| / (s_y + s_z), the distance from the nearest f whose R is not unique.
 * One step from 1 deg, two from 30. */
SB_INLINE sb_quat sb_m3_polar(sb_mat3 f, sb_quat start)
{
    sb_real n = sb_quat_dot(start, start), last, scale;
    sb_quat q;
    if (!(sb_abs(n - 1) < (sb_real)0.01))
        start = sb_quat_normalise(start);
    q = start;
    for (int step = 0; step < SBI_POLAR_STEPS; step++) {
        sb_vec3 u;
        if (!sbi_polar_newton(f, q, &u, &last))
            break;
        q = sbi_polar_turn(q, u);
        if (last < SBI_POLAR_LAST) {
            scale = (sb_real)1 / sb_sqrt(sb_quat_dot(q, q));
            return sb_quat_make(scale * q.w, scale * q.x, scale * q.y, scale * q.z);
        }
    }
    return sbi_polar_hard(f, start);
}
/* The same without a guess. */
SB_INLINE sb_quat sb_m3_polar_cold(sb_mat3 f) { return sb_m3_polar(f, sb_quat_identity()); }

/* sb_m3_polar for SB_POLAR_LANES matrices at once, written so that compilers turn the lanes into vector
 * instructions (-O3, or gcc 12's -O2; best with -march=native). */
#define SB_POLAR_LANES 8

/* What a batch works on. Flags are 0 or 1; as sb_real, and combined by arithmetic, because compilers turn
 * chains of conditions back into branches, which do not vectorise. */
typedef struct sbi_polar_lanes {
    sb_real start[4][SB_POLAR_LANES], q[4][SB_POLAR_LANES], next[4][SB_POLAR_LANES];
    sb_real moving[SB_POLAR_LANES]; /* not yet converged */
    sb_real hard[SB_POLAR_LANES];   /* left to the scalar function */
    sb_real good[SB_POLAR_LANES], last[SB_POLAR_LANES];
} sbi_polar_lanes;

/* One step in each moving lane. Lanes never look at each other. Loops of their own, so that no arithmetic can sink
 * into the selection; lanes that take no step turn by 0, since powers of their u may overflow. */
SBI_FORCE_INLINE void sbi_polar_batch_step(sb_real (*SB_RESTRICT f)[SB_POLAR_LANES], sbi_polar_lanes *SB_RESTRICT s)
{
    sb_real turn[3][SB_POLAR_LANES];
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_quat q = sb_quat_make(s->q[0][l], s->q[1][l], s->q[2][l], s->q[3][l]);
        sb_mat3 a;
        sb_vec3 u;
        a.m[0][0] = f[0][l], a.m[0][1] = f[1][l], a.m[0][2] = f[2][l];
        a.m[1][0] = f[3][l], a.m[1][1] = f[4][l], a.m[1][2] = f[5][l];
        a.m[2][0] = f[6][l], a.m[2][1] = f[7][l], a.m[2][2] = f[8][l];
        s->good[l] = sbi_polar_newton(a, q, &u, &s->last[l]) ? (sb_real)1 : (sb_real)0;
        turn[0][l] = u.x, turn[1][l] = u.y, turn[2][l] = u.z;
    }
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_quat q = sb_quat_make(s->q[0][l], s->q[1][l], s->q[2][l], s->q[3][l]);
        q = sbi_polar_turn(q, sb_v3_scale(s->good[l], sb_v3(turn[0][l], turn[1][l], turn[2][l])));
        s->next[0][l] = q.w, s->next[1][l] = q.x, s->next[2][l] = q.y, s->next[3][l] = q.z;
    }
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_real was = s->moving[l], go = was * s->good[l];
        s->q[0][l] = go > 0 ? s->next[0][l] : s->q[0][l];
        s->q[1][l] = go > 0 ? s->next[1][l] : s->q[1][l];
        s->q[2][l] = go > 0 ? s->next[2][l] : s->q[2][l];
        s->q[3][l] = go > 0 ? s->next[3][l] : s->q[3][l];
        s->moving[l] = s->last[l] >= SBI_POLAR_LAST ? go : 0;
        s->hard[l] += was - go;
    }
}

SBI_FORCE_INLINE int sbi_polar_any(const sb_real *flags)
{
    sb_real sum = ((flags[0] + flags[1]) + (flags[2] + flags[3])) + ((flags[4] + flags[5]) + (flags[6] + flags[7]));
    return sum > 0;
}

/* Writes the quaternions, normalised (|q|^2 within 0.95 ... 1.05: Newton for 1 / sqrt, which unlike sqrt
 * always vectorises), and the rotation matrices. */
SBI_FORCE_INLINE void sbi_polar_batch_finish(const sbi_polar_lanes *SB_RESTRICT s,
                                             sb_real (*SB_RESTRICT q)[SB_POLAR_LANES],
                                             sb_real (*SB_RESTRICT r)[SB_POLAR_LANES])
{
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_quat a = sb_quat_make(s->q[0][l], s->q[1][l], s->q[2][l], s->q[3][l]);
        sb_real n = sb_quat_dot(a, a), half = (sb_real)0.5 * n;
        sb_real y = (sb_real)1.875 - n * ((sb_real)1.25 - (sb_real)0.375 * n);
        sb_mat3 m;
        y = y * ((sb_real)1.5 - half * (y * y));
        y = y * ((sb_real)1.5 - half * (y * y));
        a = sb_quat_make(y * a.w, y * a.x, y * a.y, y * a.z);
        m = sbi_quat_to_scaled_mat3(a);
        q[0][l] = a.w, q[1][l] = a.x, q[2][l] = a.y, q[3][l] = a.z;
        r[0][l] = m.m[0][0], r[1][l] = m.m[0][1], r[2][l] = m.m[0][2];
        r[3][l] = m.m[1][0], r[4][l] = m.m[1][1], r[5][l] = m.m[1][2];
        r[6][l] = m.m[2][0], r[7][l] = m.m[2][1], r[8][l] = m.m[2][2];
    }
}

/* One lane by the scalar function. */
SB_INLINE void sbi_polar_lane(sb_real (*f)[SB_POLAR_LANES], sb_real (*start)[SB_POLAR_LANES],
                              sb_real (*q)[SB_POLAR_LANES], sb_real (*r)[SB_POLAR_LANES], int l)
{
    sb_mat3 a, m;
    sb_quat p;
    for (int i = 0; i < 9; i++)
        a.m[i / 3][i % 3] = f[i][l];
    p = sb_m3_polar(a, sb_quat_make(start[0][l], start[1][l], start[2][l], start[3][l]));
    m = sb_quat_to_mat3(p);
    q[0][l] = p.w, q[1][l] = p.x, q[2][l] = p.y, q[3][l] = p.z;
    for (int i = 0; i < 9; i++)
        r[i][l] = m.m[i / 3][i % 3];
}

/* sb_polar_batch, for loops that are compiled for several processors. */
SBI_FORCE_INLINE void sbi_polar_batch(sb_real (*SB_RESTRICT f)[SB_POLAR_LANES],
                                      sb_real (*SB_RESTRICT q)[SB_POLAR_LANES],
                                      sb_real (*SB_RESTRICT r)[SB_POLAR_LANES])
{
    sbi_polar_lanes s;
    int some_hard;
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_real n = q[0][l] * q[0][l] + q[1][l] * q[1][l] + q[2][l] * q[2][l] + q[3][l] * q[3][l];
        int unit = (n > (sb_real)0.99) & (n < (sb_real)1.01);
        s.start[0][l] = s.q[0][l] = q[0][l], s.start[1][l] = s.q[1][l] = q[1][l];
        s.start[2][l] = s.q[2][l] = q[2][l], s.start[3][l] = s.q[3][l] = q[3][l];
        s.moving[l] = unit ? (sb_real)1 : (sb_real)0;
        s.hard[l] = unit ? (sb_real)0 : (sb_real)1;
    }
    for (int step = 0; step < SBI_POLAR_STEPS; step++) {
        sbi_polar_batch_step(f, &s);
        if (!sbi_polar_any(s.moving))
            break;
    }
    for (int l = 0; l < SB_POLAR_LANES; l++)
        s.hard[l] += s.moving[l];
    some_hard = sbi_polar_any(s.hard);
    for (int k = 0; some_hard && k < 4; k++) /* these may have any length, and would overflow on the way to theirs */
        for (int l = 0; l < SB_POLAR_LANES; l++)
            s.q[k][l] = s.hard[l] > 0 ? (sb_real)0.5 : s.q[k][l];
    sbi_polar_batch_finish(&s, q, r);
    for (int l = 0; some_hard && l < SB_POLAR_LANES; l++)
        if (s.hard[l] > 0)
            sbi_polar_lane(f, s.start, q, r, l);
}

/* Rotations of SB_POLAR_LANES matrices. f[3 i + j][lane] = F_ij, only read. q[w, x, y, z][lane]: warm starts
 * in, unit quaternions out. r[3 i + j][lane] = R_ij. Fill unused lanes with a copy of a used one (or f = I, q
 * = 1). Each lane's result depends on that lane only, and is what sb_m3_polar gives up to rounding: lanes
 * that are hard, or have not converged after four steps, are handed to it. */
SB_INLINE void sb_polar_batch(sb_real (*SB_RESTRICT f)[SB_POLAR_LANES], sb_real (*SB_RESTRICT q)[SB_POLAR_LANES],
                              sb_real (*SB_RESTRICT r)[SB_POLAR_LANES])
{
    sbi_polar_batch(f, q, r);
}

#undef SBI_POLAR_STEPS
#undef SBI_POLAR_LAST
#undef SBI_POLAR_DEFINITE
#undef SBI_POLAR_LEAST
#undef SBI_POLAR_MOST

/* ---- small dense systems ----------------------------------------------------------------------------------
 * Row-major matrices in the caller's memory, factored in place; right-hand sides become solutions in place.
 * A factorisation returns 0, or k + 1 when step k meets a pivot that cannot be distinguished from the rounding of the
 * sums that made it (singular, not positive definite), or that is not finite. That test does not depend on
 * units or on the scaling of rows and columns; a matrix that is singular only to rounding may pass it where
 * its leading part is ill conditioned too. After a failure the matrix is partly overwritten and must not be
 * used to solve. Multiply-adds: n^3/6 (Cholesky, LDL^T), n^3/3 (LU), m n^2 (QR). For n up to about 100. */

/* Is a pivot, made by n sums whose terms have the total size `size`, no more than their rounding (or NaN)? */
SB_INLINE int sbi_dense_is_lost(sb_real pivot, int n, sb_real size)
{
    return !(sb_abs(pivot) > 4 * (sb_real)n * SB_EPSILON * size) || !sb_is_finite(size);
}

SB_INLINE sb_real sbi_dense_dot(const sb_real *a, const sb_real *b, int count)
{
    sb_real sum = 0;
    for (int i = 0; i < count; i++)
        sum += a[i] * b[i];
    return sum;
}

/* a = L L^T for a symmetric positive definite a[n][n]. Reads and overwrites the lower triangle (L); the upper
 * one is left alone. Returns 0, or the failing column + 1. */
SB_INLINE int sb_cholesky_factor(sb_real *a, int n)
{
    for (int i = 0; i < n; i++) {
        sb_real *row = a + (size_t)i * (size_t)n, sum, pivot;
        for (int j = 0; j < i; j++) {
            const sb_real *other = a + (size_t)j * (size_t)n;
            row[j] = (row[j] - sbi_dense_dot(row, other, j)) / other[j];
        }
        sum = sbi_dense_dot(row, row, i);
        pivot = row[i] - sum;
        if (!(pivot > 0) || sbi_dense_is_lost(pivot, n, sb_abs(row[i]) + sum))
            return i + 1;
        row[i] = sb_sqrt(pivot);
    }
    return 0;
}

/* Solves L L^T x = b; l from sb_cholesky_factor, x replaces b[n]. */
SB_INLINE void sb_cholesky_solve(const sb_real *l, int n, sb_real *b)
{
    for (int i = 0; i < n; i++) {
        const sb_real *row = l + (size_t)i * (size_t)n;
        b[i] = (b[i] - sbi_dense_dot(row, b, i)) / row[i];
    }
    for (int i = n - 1; i >= 0; i--) {
        const sb_real *row = l + (size_t)i * (size_t)n;
        b[i] /= row[i];
        for (int j = 0; j < i; j++)
            b[j] -= row[j] * b[i];
    }
}

/* a = L D L^T, L with unit diagonal, D of either sign, for a symmetric a[n][n] whose leading minors are not 0
 * (positive or negative definite, or quasi-definite; no pivoting). Reads and overwrites the lower triangle: L
 * below the diagonal, D on it. Returns 0, or the failing column + 1. */
SB_INLINE int sb_ldlt_factor(sb_real *a, int n)
{
    for (int i = 0; i < n; i++) {
        sb_real *row = a + (size_t)i * (size_t)n, sum, size;
        for (int j = 0; j < i; j++) /* leaves row[j] = L_ij D_j */
            row[j] -= sbi_dense_dot(row, a + (size_t)j * (size_t)n, j);
        sum = row[i];
        size = sb_abs(row[i]);
        for (int j = 0; j < i; j++) {
            sb_real scaled = row[j];
            row[j] = scaled / a[(size_t)j * (size_t)n + (size_t)j];
            sum -= scaled * row[j];
            size += sb_abs(scaled * row[j]);
        }
        if (sbi_dense_is_lost(sum, n, size))
            return i + 1;
        row[i] = sum;
    }
    return 0;
}

/* Solves L D L^T x = b; l from sb_ldlt_factor, x replaces b[n]. */
SB_INLINE void sb_ldlt_solve(const sb_real *l, int n, sb_real *b)
{
    for (int i = 0; i < n; i++)
        b[i] -= sbi_dense_dot(l + (size_t)i * (size_t)n, b, i);
    for (int i = 0; i < n; i++)
        b[i] /= l[(size_t)i * (size_t)n + (size_t)i];
    for (int i = n - 1; i >= 0; i--)
        for (int j = 0; j < i; j++)
            b[j] -= l[(size_t)i * (size_t)n + (size_t)j] * b[i];
}

/* Column k of the LU factors above and on the diagonal and, not yet divided, below it. Returns the row of the
 * largest entry from k down, or -1 when no entry can be distinguished from rounding. */
SB_INLINE int sbi_dense_lu_column(sb_real *a, int n, int k)
{
    sb_real best = 0, best_size = 0, size_total = 0;
    int row = k;
    for (int i = 0; i < n; i++) {
        sb_real *r = a + (size_t)i * (size_t)n, size = sb_abs(r[k]);
        for (int j = 0; j < i && j < k; j++) {
            sb_real product = r[j] * a[(size_t)j * (size_t)n + (size_t)k];
            r[k] -= product;
            size += sb_abs(product);
        }
        size_total += size;
        if (i >= k && sb_abs(r[k]) > best) {
            best = sb_abs(r[k]);
            best_size = size;
            row = i;
        }
    }
    return sbi_dense_is_lost(best, n, best_size) || !sb_is_finite(size_total) ? -1 : row;
}

/* P a = L U with row exchanges, for any regular a[n][n]. U replaces the upper triangle, L (unit diagonal) the
 * rest; pivot[k] (n ints) is the row exchanged with row k. Returns 0, or the failing column + 1. */
SB_INLINE int sb_lu_factor(sb_real *a, int n, int *pivot)
{
    for (int k = 0; k < n; k++) {
        int row = sbi_dense_lu_column(a, n, k);
        if (row < 0)
            return k + 1;
        pivot[k] = row;
        for (int j = 0; j < n && row != k; j++) {
            sb_real *one = a + (size_t)k * (size_t)n + (size_t)j, *two = a + (size_t)row * (size_t)n + (size_t)j;
            sb_real swap = *one;
            *one = *two;
            *two = swap;
        }
        for (int i = k + 1; i < n; i++)
            a[(size_t)i * (size_t)n + (size_t)k] /= a[(size_t)k * (size_t)n + (size_t)k];
    }
    return 0;
}

/* Solves a x = b; lu and pivot from sb_lu_factor, x replaces b[n]. */
SB_INLINE void sb_lu_solve(const sb_real *lu, int n, const int *pivot, sb_real *b)
{
    for (int k = 0; k < n; k++) {
        sb_real swap = b[k];
        b[k] = b[pivot[k]];
        b[pivot[k]] = swap;
    }
    for (int i = 0; i < n; i++)
        b[i] -= sbi_dense_dot(lu + (size_t)i * (size_t)n, b, i);
    for (int i = n - 1; i >= 0; i--) {
        const sb_real *row = lu + (size_t)i * (size_t)n;
        b[i] = (b[i] - sbi_dense_dot(row + i + 1, b + i + 1, n - 1 - i)) / row[i];
    }
}

/* Length of a[0], a[stride], ... (count entries), without over- or underflow of squares. */
SB_INLINE sb_real sbi_dense_column_norm(const sb_real *a, int count, size_t stride)
{
    sb_real size = 0, sum = 0;
    for (int i = 0; i < count; i++) {
        sb_real entry = sb_abs(a[(size_t)i * stride]);
        size = entry > size || entry != entry ? entry : size;
    }
    if (!(size > 0) || !sb_is_finite(size))
        return size;
    for (int i = 0; i < count; i++) {
        sb_real entry = a[(size_t)i * stride] / size;
        sum += entry * entry;
    }
    return size * sb_sqrt(sum);
}

/* x -= tau v (v.x) with v = (1, a[stride], a[2 stride] ...) and x = x[0], x[step] ...; count entries each. */
SB_INLINE void sbi_dense_reflect(const sb_real *a, size_t stride, sb_real tau, sb_real *x, size_t step, int count)
{
    sb_real sum = x[0];
    for (int i = 1; i < count; i++)
        sum += a[(size_t)i * stride] * x[(size_t)i * step];
    sum *= tau;
    x[0] -= sum;
    for (int i = 1; i < count; i++)
        x[(size_t)i * step] -= sum * a[(size_t)i * stride];
}

/* a = Q R for a[m][n], m >= n, by Householder reflections I - tau v v^T. R replaces the upper triangle, v
 * (v_k = 1 implied) the rest; tau has n entries. Returns 0, or k + 1 when column k depends on those before it
 * (to rounding), is zero or not finite; m + n + 1 when m < n. */
SB_INLINE int sb_qr_factor(sb_real *a, int m, int n, sb_real *tau)
{
    size_t stride = (size_t)n;
    if (m < n)
        return m + n + 1;
    for (int k = 0; k < n; k++) {
        sb_real *v = a + (size_t)k * stride + (size_t)k, head, norm, whole;
        norm = sbi_dense_column_norm(v, m - k, stride);
        whole = sbi_dense_column_norm(a + k, m, stride); /* reflections keep it: the original length */
        if (sbi_dense_is_lost(norm, m, whole))
            return k + 1;
        head = v[0] > 0 ? -norm : norm; /* the sign without cancellation */
        tau[k] = (head - v[0]) / head;
        for (int i = 1; i < m - k; i++)
            v[(size_t)i * stride] /= v[0] - head;
        for (int j = k + 1; j < n; j++)
            sbi_dense_reflect(v, stride, tau[k], v + (j - k), stride, m - k);
        v[0] = head;
    }
    return 0;
}

/* Least squares: x of length n that minimises |a x - b|; qr and tau from sb_qr_factor. x replaces b[0..n);
 * the rest of b[m] becomes the part of b no x can reach: |a x - b| is its length. */
SB_INLINE void sb_qr_solve(const sb_real *qr, int m, int n, const sb_real *tau, sb_real *b)
{
    for (int k = 0; k < n; k++)
        sbi_dense_reflect(qr + (size_t)k * (size_t)n + (size_t)k, (size_t)n, tau[k], b + k, 1, m - k);
    for (int i = n - 1; i >= 0; i--) {
        const sb_real *row = qr + (size_t)i * (size_t)n;
        b[i] = (b[i] - sbi_dense_dot(row + i + 1, b + i + 1, n - 1 - i)) / row[i];
    }
}

/* Lower Cholesky factor of a symmetric positive definite 3x3 (its lower triangle is read), zeros above.
 * Returns 0, or the failing column + 1 with *l untouched. */
SB_INLINE int sb_m3_cholesky(sb_mat3 a, sb_mat3 *l)
{
    int failed = sb_cholesky_factor(&a.m[0][0], 3);
    if (failed)
        return failed;
    a.m[0][1] = a.m[0][2] = a.m[1][2] = 0;
    *l = a;
    return 0;
}

/* Inverse of a symmetric positive definite 3x3 (its lower triangle is read), exactly symmetric. Returns 0, or
 * the failing column + 1 with *inverse untouched. */
SB_INLINE int sb_m3_spd_inverse(sb_mat3 a, sb_mat3 *inverse)
{
    sb_mat3 l, g, result;
    int failed = sb_m3_cholesky(a, &l);
    if (failed)
        return failed;
    g = sb_m3_zero(); /* g = L^-1, a^-1 = g^T g */
    for (int i = 0; i < 3; i++)
        g.m[i][i] = (sb_real)1 / l.m[i][i];
    g.m[1][0] = -l.m[1][0] * g.m[0][0] * g.m[1][1];
    g.m[2][1] = -l.m[2][1] * g.m[1][1] * g.m[2][2];
    g.m[2][0] = -(l.m[2][0] * g.m[0][0] + l.m[2][1] * g.m[1][0]) * g.m[2][2];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j <= i; j++) {
            sb_real sum = g.m[i][i] * g.m[i][j];
            for (int k = i + 1; k < 3; k++)
                sum += g.m[k][i] * g.m[k][j];
            result.m[i][j] = result.m[j][i] = sum;
        }
    *inverse = result;
    return 0;
}

#endif /* SB_DENSE_H */
