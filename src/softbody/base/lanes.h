/* lanes: four reals as one vector where compiler and processor have them, or two where doubles come without AVX; loops
 * over lanes that take what the processor has. Floor 0, internal.
 *
 * Memory is read at any alignment. Code with SBI_HAS_LANES or SBI_HAS_PAIRS has a plain form beside it that gives the
 * same bits; SB_NO_VECTORS asks for that one. */
#ifndef SB_LANES_H
#define SB_LANES_H

#include "core.h"

#if defined(__GNUC__) && !defined(SB_NO_VECTORS) && (defined(__AVX__) || SB_REAL_IS_FLOAT)
#define SBI_HAS_LANES 1
typedef sb_real sbi_lanes __attribute__((vector_size(4 * sizeof(sb_real)), aligned(sizeof(sb_real)), may_alias));
#define SBI_LANES_AT(pointer) (*(const sbi_lanes *)(const void *)(pointer))
#define SBI_LANES_PUT(pointer, value) (*(sbi_lanes *)(void *)(pointer) = (value))
#define SBI_HAS_PAIRS 0
#elif defined(__GNUC__) && !defined(SB_NO_VECTORS)
#define SBI_HAS_LANES 0
#define SBI_HAS_PAIRS 1
typedef sb_real sbi_pair __attribute__((vector_size(2 * sizeof(sb_real)), aligned(sizeof(sb_real)), may_alias));
#define SBI_PAIR_AT(pointer) (*(const sbi_pair *)(const void *)(pointer))

SBI_FORCE_INLINE sbi_pair sbi_pair_make(sb_real a, sb_real b)
{
    sbi_pair v = {a, b};
    return v;
}
#else
#define SBI_HAS_LANES 0
#define SBI_HAS_PAIRS 0
#endif

/* A loop over lanes of arrays: gcc would unroll it before it can see vectors in it, and then spill what it unrolled. */
#if defined(__GNUC__) && !defined(__clang__) && __GNUC__ >= 8
#define SBI_EACH_LANE(l, count) _Pragma("GCC unroll 1") for (int l = 0; l < (count); l++)
#else
#define SBI_EACH_LANE(l, count) for (int l = 0; l < (count); l++)
#endif

/* SBI_WIDEN(f, wide, (parameters), (arguments)) defines f, which runs f_lanes: also compiled for AVX2, and so run where
 * `wide` is not 0, which sbi_lanes_are_wide() has said. Programs that are compiled for every x86-64 get vectors of four
 * doubles that way. Without fused products, and no lane looks at another: the same bits. f_lanes and what it calls in
 * its loops are SBI_FORCE_INLINE, lest they stay as narrow as the rest of the file. Not by gcc for Windows, which does
 * not align such vectors on the stack (gcc bug 54412).
 * SBI_WIDEN_IF(f, (parameters), (arguments)): the same where f and f_lanes have a parameter before those, `wide`, which
 * is a constant in f_lanes: for loops that are written twice. */
#define SBI_LIST(...) __VA_ARGS__
#if defined(__GNUC__) && defined(__x86_64__) && !defined(_MSC_VER) && !defined(__AVX2__) && !defined(SB_NO_VECTORS) && \
    !(defined(_WIN32) && !defined(__clang__))
#define SBI_IS_WIDENED 1
#include <cpuid.h>

/* 1: processor and system have AVX2. Asked of the processor, which takes as long as a thousand products: once, when a
 * thing is made. The compiler's own way asks a run-time library that not all have. */
SB_INLINE int sbi_lanes_are_wide(void)
{
    const unsigned saved = 1u << 27, avx = 1u << 28, avx2 = 1u << 5, registers = 6;
    unsigned a, b, c, d;
    if (__get_cpuid_max(0, NULL) < 7)
        return 0;
    __cpuid(1, a, b, c, d);
    if ((c & (saved | avx)) != (saved | avx))
        return 0;
    __asm__("xgetbv" : "=a"(a), "=d"(d) : "c"(0)); /* what the system saves of them */
    if ((a & registers) != registers)
        return 0;
    __cpuid_count(7, 0, a, b, c, d);
    return (b & avx2) != 0;
}

#define SBI_WIDEN(name, wide, parameters, arguments)                                                                   \
    static __attribute__((target("avx2"), noinline)) void name##_wide parameters { name##_lanes arguments; }           \
    static void name parameters                                                                                        \
    {                                                                                                                  \
        if (wide)                                                                                                      \
            name##_wide arguments;                                                                                     \
        else                                                                                                           \
            name##_lanes arguments;                                                                                    \
    }
#define SBI_WIDEN_IF(name, parameters, arguments)                                                                      \
    static __attribute__((target("avx2"), noinline)) void name##_wide parameters                                       \
    {                                                                                                                  \
        name##_lanes(1, SBI_LIST arguments);                                                                           \
    }                                                                                                                  \
    static void name(int wide, SBI_LIST parameters)                                                                    \
    {                                                                                                                  \
        if (wide)                                                                                                      \
            name##_wide arguments;                                                                                     \
        else                                                                                                           \
            name##_lanes(0, SBI_LIST arguments);                                                                       \
    }
#else
#define SBI_IS_WIDENED 0
SB_INLINE int sbi_lanes_are_wide(void) { return 0; }
#define SBI_WIDEN(name, wide, parameters, arguments)                                                                   \
    static void name parameters { name##_lanes arguments; }
#define SBI_WIDEN_IF(name, parameters, arguments)                                                                      \
    static void name(int wide, SBI_LIST parameters) { name##_lanes(wide, SBI_LIST arguments); }
#endif

#endif /* SB_LANES_H */
