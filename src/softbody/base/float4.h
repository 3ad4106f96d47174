/* float4: four floats as one vector. Floor 0, internal.
 *
 * Blocks are stored as three rows of four floats, the fourth unused (0), so that a row is one vector. The compiler's
 * own vectors where it has them, else plain code with the same roundings. */
#ifndef SB_FLOAT4_H
#define SB_FLOAT4_H

#include "lanes.h"

#if defined(__GNUC__) && !defined(SB_NO_VECTORS)
#define SBI_HAS_FLOAT4 1
typedef float sbi_float4 __attribute__((vector_size(16), may_alias));
#define SBI_F4(v, k) ((v)[k])
#else
#define SBI_HAS_FLOAT4 0
typedef struct sbi_float4 {
    float lane[4];
} sbi_float4;
#define SBI_F4(v, k) ((v).lane[k])
#endif

SBI_FORCE_INLINE sbi_float4 sbi_f4_make(float a, float b, float c)
{
#if SBI_HAS_FLOAT4
    sbi_float4 v = {a, b, c, 0};
#else
    sbi_float4 v = {{a, b, c, 0}};
#endif
    return v;
}

SBI_FORCE_INLINE sbi_float4 sbi_f4_load(const float *from) { return *(const sbi_float4 *)(const void *)from; }
SBI_FORCE_INLINE void sbi_f4_store(float *to, sbi_float4 v) { *(sbi_float4 *)(void *)to = v; }

SBI_FORCE_INLINE sbi_float4 sbi_f4_add(sbi_float4 a, sbi_float4 b)
{
#if SBI_HAS_FLOAT4
    return a + b;
#else
    for (int k = 0; k < 4; k++)
        a.lane[k] += b.lane[k];
    return a;
#endif
}

SBI_FORCE_INLINE sbi_float4 sbi_f4_sub(sbi_float4 a, sbi_float4 b)
{
#if SBI_HAS_FLOAT4
    return a - b;
#else
    for (int k = 0; k < 4; k++)
        a.lane[k] -= b.lane[k];
    return a;
#endif
}

SBI_FORCE_INLINE sbi_float4 sbi_f4_mul(sbi_float4 a, sbi_float4 b)
{
#if SBI_HAS_FLOAT4
    return a * b;
#else
    for (int k = 0; k < 4; k++)
        a.lane[k] *= b.lane[k];
    return a;
#endif
}

SBI_FORCE_INLINE sbi_float4 sbi_f4_scale(float s, sbi_float4 a)
{
#if SBI_HAS_FLOAT4
    return a * s;
#else
    for (int k = 0; k < 4; k++)
        a.lane[k] *= s;
    return a;
#endif
}

/* a[0] m.row0 + a[1] m.row1 + a[2] m.row2 = m^T a */
SBI_FORCE_INLINE sbi_float4 sbi_f4_rows(sbi_float4 a, const float *m)
{
    return sbi_f4_add(
        sbi_f4_add(sbi_f4_scale(SBI_F4(a, 0), sbi_f4_load(m)), sbi_f4_scale(SBI_F4(a, 1), sbi_f4_load(m + 4))),
        sbi_f4_scale(SBI_F4(a, 2), sbi_f4_load(m + 8)));
}

SBI_FORCE_INLINE float sbi_f4_sum(sbi_float4 a) { return SBI_F4(a, 0) + SBI_F4(a, 1) + SBI_F4(a, 2); }

#if SBI_HAS_FLOAT4 && defined(__has_builtin)
#if __has_builtin(__builtin_shufflevector)
#define SBI_HAS_SHUFFLE 1
#endif
#endif

/* (sum of a, sum of b, sum of c, anything), to the bits of sbi_f4_sum. */
SBI_FORCE_INLINE sbi_float4 sbi_f4_sums(sbi_float4 a, sbi_float4 b, sbi_float4 c)
{
#if defined(SBI_HAS_SHUFFLE)
    sbi_float4 low = __builtin_shufflevector(a, b, 0, 4, 1, 5), high = __builtin_shufflevector(a, b, 2, 6, 3, 7);
    sbi_float4 first = __builtin_shufflevector(low, c, 0, 1, 4, 7),
               second = __builtin_shufflevector(low, c, 2, 3, 5, 7);
    return sbi_f4_add(sbi_f4_add(first, second), __builtin_shufflevector(high, c, 0, 1, 6, 7));
#else
    return sbi_f4_make(sbi_f4_sum(a), sbi_f4_sum(b), sbi_f4_sum(c));
#endif
}

/* Row of three reals, rounded after scaling. sbi_f4_round_row may read a fourth and leave anything in that
 * lane: for rows of matrix blocks and right sides, whose fourth lane never reaches a result. */
SBI_FORCE_INLINE sbi_float4 sbi_f4_round(const sb_real *from, sb_real scale)
{
    return sbi_f4_make((float)(from[0] * scale), (float)(from[1] * scale), (float)(from[2] * scale));
}

SBI_FORCE_INLINE sbi_float4 sbi_f4_round_row(const sb_real *from, sb_real scale)
{
#if SBI_HAS_LANES && SB_REAL_IS_FLOAT
    return SBI_LANES_AT(from) * scale;
#elif SBI_HAS_LANES && (defined(__clang__) || __GNUC__ >= 9)
    return __builtin_convertvector(SBI_LANES_AT(from) * scale, sbi_float4);
#else
    return sbi_f4_round(from, scale);
#endif
}

#endif /* SB_FLOAT4_H */
