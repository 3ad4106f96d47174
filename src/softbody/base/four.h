/* four: four floats at a time, at any address. Floor 0, internal. The plain code gives the same bits.
 * sbi_four_exceeds: not 0 when any of a's is greater than b's. */
#ifndef SB_FOUR_H
#define SB_FOUR_H

#include <math.h>
#include <string.h>

#include "core.h"

#if defined(__GNUC__)
typedef float sbi_four __attribute__((vector_size(16)));
typedef int32_t sbi_four_mask __attribute__((vector_size(16)));
SBI_FORCE_INLINE sbi_four sbi_four_make(float a, float b, float c, float d)
{
    sbi_four r = {a, b, c, d};
    return r;
}
SBI_FORCE_INLINE sbi_four sbi_four_of(float x)
{
    sbi_four r = {x, x, x, x};
    return r;
}
SBI_FORCE_INLINE sbi_four sbi_four_load(const float *x)
{
    sbi_four r;
    memcpy(&r, x, sizeof r);
    return r;
}
SBI_FORCE_INLINE void sbi_four_store(float *x, sbi_four a) { memcpy(x, &a, sizeof a); }
SBI_FORCE_INLINE sbi_four sbi_four_add(sbi_four a, sbi_four b) { return a + b; }
SBI_FORCE_INLINE sbi_four sbi_four_sub(sbi_four a, sbi_four b) { return a - b; }
SBI_FORCE_INLINE sbi_four sbi_four_mul(sbi_four a, sbi_four b) { return a * b; }
SBI_FORCE_INLINE sbi_four sbi_four_madd(sbi_four a, sbi_four s, sbi_four b) { return a + s * b; }
#if defined(__SSE__)
SBI_FORCE_INLINE sbi_four sbi_four_sqrt(sbi_four a) { return __builtin_ia32_sqrtps(a); }
SBI_FORCE_INLINE sbi_four sbi_four_max(sbi_four a, sbi_four b) { return __builtin_ia32_maxps(a, b); }
SBI_FORCE_INLINE sbi_four sbi_four_min(sbi_four a, sbi_four b) { return __builtin_ia32_minps(a, b); }
SBI_FORCE_INLINE int sbi_four_exceeds(sbi_four a, sbi_four b) { return __builtin_ia32_movmskps((sbi_four)(a > b)); }
#else
SBI_FORCE_INLINE sbi_four sbi_four_choose(sbi_four_mask mask, sbi_four a, sbi_four b)
{
    return (sbi_four)((mask & (sbi_four_mask)a) | (~mask & (sbi_four_mask)b));
}
SBI_FORCE_INLINE sbi_four sbi_four_max(sbi_four a, sbi_four b) { return sbi_four_choose(a > b, a, b); }
SBI_FORCE_INLINE sbi_four sbi_four_min(sbi_four a, sbi_four b) { return sbi_four_choose(a < b, a, b); }
SBI_FORCE_INLINE int sbi_four_exceeds(sbi_four a, sbi_four b)
{
    sbi_four_mask more = a > b;
    return (more[0] | more[1] | more[2] | more[3]) != 0;
}
SBI_FORCE_INLINE sbi_four sbi_four_sqrt(sbi_four a)
{
    for (int k = 0; k < 4; k++)
        a[k] = (float)sqrt((double)a[k]);
    return a;
}
#endif
#else
typedef struct sbi_four {
    float v[4];
} sbi_four;
SBI_FORCE_INLINE sbi_four sbi_four_make(float a, float b, float c, float d)
{
    sbi_four r = {{a, b, c, d}};
    return r;
}
SBI_FORCE_INLINE sbi_four sbi_four_of(float x)
{
    sbi_four r;
    for (int k = 0; k < 4; k++)
        r.v[k] = x;
    return r;
}
SBI_FORCE_INLINE sbi_four sbi_four_load(const float *x)
{
    sbi_four r;
    memcpy(&r, x, sizeof r);
    return r;
}
SBI_FORCE_INLINE void sbi_four_store(float *x, sbi_four a) { memcpy(x, &a, sizeof a); }
SBI_FORCE_INLINE sbi_four sbi_four_add(sbi_four a, sbi_four b)
{
    for (int k = 0; k < 4; k++)
        a.v[k] += b.v[k];
    return a;
}
SBI_FORCE_INLINE sbi_four sbi_four_sub(sbi_four a, sbi_four b)
{
    for (int k = 0; k < 4; k++)
        a.v[k] -= b.v[k];
    return a;
}
SBI_FORCE_INLINE sbi_four sbi_four_mul(sbi_four a, sbi_four b)
{
    for (int k = 0; k < 4; k++)
        a.v[k] *= b.v[k];
    return a;
}
SBI_FORCE_INLINE sbi_four sbi_four_madd(sbi_four a, sbi_four s, sbi_four b)
{
    for (int k = 0; k < 4; k++)
        a.v[k] += s.v[k] * b.v[k];
    return a;
}
SBI_FORCE_INLINE sbi_four sbi_four_max(sbi_four a, sbi_four b)
{
    for (int k = 0; k < 4; k++)
        a.v[k] = a.v[k] > b.v[k] ? a.v[k] : b.v[k];
    return a;
}
SBI_FORCE_INLINE sbi_four sbi_four_min(sbi_four a, sbi_four b)
{
    for (int k = 0; k < 4; k++)
        a.v[k] = a.v[k] < b.v[k] ? a.v[k] : b.v[k];
    return a;
}
SBI_FORCE_INLINE int sbi_four_exceeds(sbi_four a, sbi_four b)
{
    return (a.v[0] > b.v[0]) | (a.v[1] > b.v[1]) | (a.v[2] > b.v[2]) | (a.v[3] > b.v[3]);
}
SBI_FORCE_INLINE sbi_four sbi_four_sqrt(sbi_four a)
{
    for (int k = 0; k < 4; k++)
        a.v[k] = (float)sqrt((double)a.v[k]);
    return a;
}
#endif

/* ---- eight at a time, where minima are all that is asked for ---- */

#if defined(__GNUC__) && defined(__AVX__)
typedef float sbi_eight __attribute__((vector_size(32)));
SBI_FORCE_INLINE sbi_eight sbi_eight_load(const float *x)
{
    sbi_eight r;
    memcpy(&r, x, sizeof r);
    return r;
}
SBI_FORCE_INLINE void sbi_eight_store(float *x, sbi_eight a) { memcpy(x, &a, sizeof a); }
SBI_FORCE_INLINE sbi_eight sbi_eight_min(sbi_eight a, sbi_eight b) { return __builtin_ia32_minps256(a, b); }
#else
typedef struct sbi_eight {
    sbi_four low, high;
} sbi_eight;
SBI_FORCE_INLINE sbi_eight sbi_eight_load(const float *x)
{
    sbi_eight r;
    r.low = sbi_four_load(x);
    r.high = sbi_four_load(x + 4);
    return r;
}
SBI_FORCE_INLINE void sbi_eight_store(float *x, sbi_eight a)
{
    sbi_four_store(x, a.low);
    sbi_four_store(x + 4, a.high);
}
SBI_FORCE_INLINE sbi_eight sbi_eight_min(sbi_eight a, sbi_eight b)
{
    a.low = sbi_four_min(a.low, b.low);
    a.high = sbi_four_min(a.high, b.high);
    return a;
}
#endif

#endif /* SB_FOUR_H */
