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

/* SBI_WIDEN(f, (parameters), (arguments)) defines f, which runs f_lanes: also compiled for AVX2, and so run where the
 * processor has it. Programs that are compiled for every x86-64 get vectors of four doubles that way. Without fused
 * products, and no lane looks at another: the same bits. f_lanes and what it calls in its loops are SBI_FORCE_INLINE,
 * lest they stay as narrow as the rest of the file. */
#if defined(__GNUC__) && defined(__x86_64__) && !defined(_MSC_VER) && !defined(__AVX2__) && !defined(SB_NO_VECTORS)
#define SBI_WIDEN(name, parameters, arguments)                                                                         \
    static __attribute__((target("avx2"), noinline)) void name##_wide parameters { name##_lanes arguments; }           \
    static void name parameters                                                                                        \
    {                                                                                                                  \
        if (__builtin_cpu_supports("avx2"))                                                                            \
            name##_wide arguments;                                                                                     \
        else                                                                                                           \
            name##_lanes arguments;                                                                                    \
    }
#else
#define SBI_WIDEN(name, parameters, arguments)                                                                         \
    static void name parameters { name##_lanes arguments; }
#endif

#endif /* SB_LANES_H */
