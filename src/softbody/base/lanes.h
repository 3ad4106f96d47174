/* lanes: four reals as one vector where compiler and processor have them (doubles without AVX do not). Floor 0,
 * internal.
 *
 * Memory is read at any alignment. Code with SBI_HAS_LANES has a plain form beside it that gives the same bits;
 * SB_NO_VECTORS asks for that one. */
#ifndef SB_LANES_H
#define SB_LANES_H

#include "core.h"

#if defined(__GNUC__) && !defined(SB_NO_VECTORS) && (defined(__AVX__) || SB_REAL_IS_FLOAT)
#define SBI_HAS_LANES 1
typedef sb_real sbi_lanes __attribute__((vector_size(4 * sizeof(sb_real)), aligned(sizeof(sb_real)), may_alias));
#define SBI_LANES_AT(pointer) (*(const sbi_lanes *)(const void *)(pointer))
#define SBI_LANES_PUT(pointer, value) (*(sbi_lanes *)(void *)(pointer) = (value))
#else
#define SBI_HAS_LANES 0
#endif

#endif /* SB_LANES_H */
