/* multigrid_block: blocks of nine, packed and multiplied in the forms that processors have. Floor 1, internal to the
 * multigrid.
 *
 * Compilers find none of these vectors by themselves. All forms give the same bits for finite matrices: sums of rows
 * have one sum for each place of the blocks, so that none waits for another, and what a vector holds beside its block
 * is multiplied by the fourth float of a node, which is 0. */
#ifndef SB_MULTIGRID_BLOCK_H
#define SB_MULTIGRID_BLOCK_H

#include "../base/float4.h"
#include "multigrid_level.h"

#include <string.h>

#if !defined(__GNUC__) || defined(SB_NO_VECTORS)
#define SBI_MG_WIDTH 0 /* plain code */
#elif defined(__AVX512F__)
#define SBI_MG_WIDTH 512 /* bits of vectors; those of fewer are used where they do better */
#elif defined(__AVX2__)
#define SBI_MG_WIDTH 256
#else
#define SBI_MG_WIDTH 128
#endif
#if SBI_MG_WIDTH >= 256
#include <immintrin.h>
#elif SBI_MG_WIDTH && defined(__SSE2__)
#include <emmintrin.h>
#endif
#if SBI_MG_WIDTH && defined(__SSE2__)
#define SBI_MG_SSE 1
#else
#define SBI_MG_SSE 0
#endif

#if SBI_MG_WIDTH
typedef float sbi_mg_four __attribute__((vector_size(16), aligned(4), may_alias)); /* at any address */
#define SBI_MG_FOUR_AT(pointer) (*(const sbi_mg_four *)(const void *)(pointer))
#define SBI_MG_PUT_FOUR(pointer, value) (*(sbi_mg_four *)(void *)(pointer) = (value))
#endif
#if SBI_MG_WIDTH >= 256
typedef float sbi_mg_eight __attribute__((vector_size(32), aligned(4), may_alias));
#define SBI_MG_EIGHT_AT(pointer) (*(const sbi_mg_eight *)(const void *)(pointer))
#define SBI_MG_PUT_EIGHT(pointer, value) (*(sbi_mg_eight *)(void *)(pointer) = (value))
#define SBI_MG_TURN(v) ((sbi_mg_eight)_mm256_permutevar8x32_ps((__m256)(v), _mm256_setr_epi32(0, 1, 2, 0, 1, 2, 0, 1)))
#endif

/* to += factor from, nine floats. */
SBI_FORCE_INLINE void sbi_mg_add_block(float factor, const float *from, float *to)
{
#if SBI_MG_WIDTH >= 256
    SBI_MG_PUT_EIGHT(to, SBI_MG_EIGHT_AT(to) + factor * SBI_MG_EIGHT_AT(from));
    to[8] += factor * from[8];
#elif SBI_MG_WIDTH
    SBI_MG_PUT_FOUR(to, SBI_MG_FOUR_AT(to) + factor * SBI_MG_FOUR_AT(from));
    SBI_MG_PUT_FOUR(to + 4, SBI_MG_FOUR_AT(to + 4) + factor * SBI_MG_FOUR_AT(from + 4));
    to[8] += factor * from[8];
#else
    for (int k = 0; k < 9; k++)
        to[k] += factor * from[k];
#endif
}

/* Asks for a block of a list in good time: they lie far apart. A list has room for being read past its end. */
SBI_FORCE_INLINE void sbi_mg_ask(const float *blocks, const int *listed)
{
    const float *block = blocks + 9 * (size_t)listed[SBI_MG_BLOCKS_AHEAD];
    SBI_PREFETCH(block, 0);
    SBI_PREFETCH(block, 32);
}

/* to = the sum of share times block of those listed. */
SBI_FORCE_INLINE void sbi_mg_sum_blocks(const int *listed, const int *end, const float *share, const float *blocks,
                                        float *to)
{
#if SBI_MG_WIDTH >= 256
    sbi_mg_eight sum = {0, 0, 0, 0, 0, 0, 0, 0};
    float last = 0;
    for (; listed < end; listed++, share++) {
        const float *block = blocks + 9 * (size_t)*listed;
        sbi_mg_ask(blocks, listed);
        sum += *share * SBI_MG_EIGHT_AT(block);
        last += *share * block[8];
    }
    SBI_MG_PUT_EIGHT(to, sum);
    to[8] = last;
#elif SBI_MG_WIDTH
    sbi_float4 low = sbi_f4_make(0, 0, 0), high = low;
    float last = 0;
    for (; listed < end; listed++, share++) {
        const float *block = blocks + 9 * (size_t)*listed;
        sbi_mg_ask(blocks, listed);
        low += *share * SBI_MG_FOUR_AT(block);
        high += *share * SBI_MG_FOUR_AT(block + 4);
        last += *share * block[8];
    }
    SBI_MG_PUT_FOUR(to, low);
    SBI_MG_PUT_FOUR(to + 4, high);
    to[8] = last;
#else
    memset(to, 0, 9 * sizeof *to);
    for (; listed < end; listed++, share++)
        for (int k = 0; k < 9; k++)
            to[k] += *share * blocks[9 * (size_t)*listed + (size_t)k];
#endif
}

/* ---- rows times vectors ---- */

#if SBI_MG_WIDTH >= 256
/* From sums of the first eight places, and of the ninth in the last lane of a vector: it begins one float before x, y,
 * z when it is made. */
SBI_FORCE_INLINE sbi_float4 sbi_mg_finish(sbi_mg_eight sum, sbi_mg_four last)
{
    enum { LAST_TO_THIRD = 3 << 6 | 2 << 4, FOURTH = 8 };
    __m256 v = (__m256)sum;
    __m128 a = _mm256_castps256_ps128(_mm256_permutevar8x32_ps(v, _mm256_setr_epi32(0, 3, 6, 7, 7, 7, 7, 7)));
    __m128 b = _mm256_castps256_ps128(_mm256_permutevar8x32_ps(v, _mm256_setr_epi32(1, 4, 7, 7, 7, 7, 7, 7)));
    __m128 c = _mm256_castps256_ps128(_mm256_permutevar8x32_ps(v, _mm256_setr_epi32(2, 5, 7, 7, 7, 7, 7, 7)));
    c = _mm_insert_ps(c, (__m128)last, LAST_TO_THIRD);
    return (sbi_float4)_mm_blend_ps(_mm_add_ps(_mm_add_ps(a, b), c), _mm_setzero_ps(), FOURTH);
}

SBI_FORCE_INLINE sbi_float4 sbi_mg_sum_floats(const float *block, const int *column, const int *end, const float *v)
{
    sbi_mg_eight sum = {0, 0, 0, 0, 0, 0, 0, 0};
    sbi_mg_four last = {0, 0, 0, 0};
    for (; column < end; column++, block += 9) {
        const float *from = v + 4 * (size_t)*column;
        sbi_mg_eight x = SBI_MG_EIGHT_AT(from);
        sum += SBI_MG_EIGHT_AT(block) * SBI_MG_TURN(x);
        last += SBI_MG_FOUR_AT(block + 5) * SBI_MG_FOUR_AT(from - 1);
    }
    return sbi_mg_finish(sum, last);
}
#elif SBI_MG_WIDTH
/* Sums of the three rows of the blocks. */
typedef struct sbi_mg_sums {
    sbi_float4 row[3];
} sbi_mg_sums;

SBI_FORCE_INLINE sbi_mg_sums sbi_mg_no_sums(void)
{
    sbi_mg_sums none;
    none.row[0] = none.row[1] = none.row[2] = sbi_f4_make(0, 0, 0);
    return none;
}

SBI_FORCE_INLINE sbi_float4 sbi_mg_sum_floats(const float *block, const int *column, const int *end, const float *v)
{
    sbi_mg_sums sums = sbi_mg_no_sums();
    for (; column < end; column++, block += 9) {
        sbi_float4 x = sbi_f4_load(v + 4 * (size_t)*column);
        sums.row[0] += SBI_MG_FOUR_AT(block) * x;
        sums.row[1] += SBI_MG_FOUR_AT(block + 3) * x;
        sums.row[2] += SBI_MG_FOUR_AT(block + 6) * x;
    }
    return sbi_f4_sums(sums.row[0], sums.row[1], sums.row[2]);
}
#else
SBI_FORCE_INLINE sbi_float4 sbi_mg_finish(const float s[9], float factor)
{
    return sbi_f4_make(s[0] * factor + s[1] * factor + s[2] * factor, s[3] * factor + s[4] * factor + s[5] * factor,
                       s[6] * factor + s[7] * factor + s[8] * factor);
}

SBI_FORCE_INLINE sbi_float4 sbi_mg_sum_floats(const float *block, const int *column, const int *end, const float *v)
{
    float s[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
    for (; column < end; column++, block += 9) {
        const float *from = v + 4 * (size_t)*column;
        for (int k = 0; k < 9; k++)
            s[k] += block[k] * from[k % 3];
    }
    return sbi_mg_finish(s, 1);
}
#endif

/* Packed blocks: even and odd ones have sums of their own. */
#if SBI_MG_WIDTH == 512
typedef __m512 sbi_mg_sums;
SBI_FORCE_INLINE sbi_mg_sums sbi_mg_no_sums(void) { return _mm512_setzero_ps(); }

/* sums + block times v, all nine places in one vector. */
SBI_FORCE_INLINE sbi_mg_sums sbi_mg_add_packed(sbi_mg_sums sums, const int16_t *block, const float *from)
{
    const __m512i places = _mm512_setr_epi32(0, 1, 2, 0, 1, 2, 0, 1, 2, 3, 3, 3, 3, 3, 3, 3);
    __m512 x = _mm512_permutexvar_ps(places, _mm512_castps128_ps512((__m128)sbi_f4_load(from)));
    __m512i entries = _mm512_cvtepi16_epi32(_mm256_loadu_si256((const __m256i *)(const void *)block));
    return _mm512_add_ps(sums, _mm512_mul_ps(_mm512_cvtepi32_ps(entries), x));
}

SBI_FORCE_INLINE sbi_float4 sbi_mg_finish_packed(sbi_mg_sums even, sbi_mg_sums odd)
{
    __m512 sum = _mm512_mul_ps(_mm512_add_ps(even, odd), _mm512_set1_ps(1 / SBI_MG_ONE));
    __m512 ninth = _mm512_permutexvar_ps(_mm512_set1_epi32(8), sum);
    return sbi_mg_finish((sbi_mg_eight)_mm512_castps512_ps256(sum), (sbi_mg_four)_mm512_castps512_ps128(ninth));
}
#elif SBI_MG_WIDTH == 256
typedef struct sbi_mg_sums {
    sbi_mg_eight eight;
    sbi_mg_four last;
} sbi_mg_sums;

SBI_FORCE_INLINE sbi_mg_sums sbi_mg_no_sums(void)
{
    sbi_mg_sums none = {{0, 0, 0, 0, 0, 0, 0, 0}, {0, 0, 0, 0}};
    return none;
}

SBI_FORCE_INLINE sbi_mg_sums sbi_mg_add_packed(sbi_mg_sums sums, const int16_t *block, const float *from)
{
    __m256i eight = _mm256_cvtepi16_epi32(_mm_loadu_si128((const __m128i *)(const void *)block));
    __m128i four = _mm_cvtepi16_epi32(_mm_loadl_epi64((const __m128i *)(const void *)(block + 5)));
    sbi_mg_eight x = SBI_MG_EIGHT_AT(from);
    sums.eight += (sbi_mg_eight)_mm256_cvtepi32_ps(eight) * SBI_MG_TURN(x);
    sums.last += (sbi_mg_four)_mm_cvtepi32_ps(four) * SBI_MG_FOUR_AT(from - 1);
    return sums;
}

SBI_FORCE_INLINE sbi_float4 sbi_mg_finish_packed(sbi_mg_sums even, sbi_mg_sums odd)
{
    return sbi_mg_finish((even.eight + odd.eight) * (1 / SBI_MG_ONE), (even.last + odd.last) * (1 / SBI_MG_ONE));
}
#elif SBI_MG_WIDTH
SBI_FORCE_INLINE sbi_float4 sbi_mg_unpack(const int16_t *from)
{
#if SBI_MG_SSE
    __m128i v = _mm_loadl_epi64((const __m128i *)(const void *)from);
    return (sbi_float4)_mm_cvtepi32_ps(_mm_srai_epi32(_mm_unpacklo_epi16(v, v), 16));
#elif defined(__clang__) || __GNUC__ >= 9
    typedef int16_t sbi_mg_shorts __attribute__((vector_size(8), aligned(2), may_alias));
    typedef int32_t sbi_mg_ints __attribute__((vector_size(16)));
    return __builtin_convertvector(__builtin_convertvector(*(const sbi_mg_shorts *)(const void *)from, sbi_mg_ints),
                                   sbi_float4);
#else
    sbi_float4 v = {(float)from[0], (float)from[1], (float)from[2], (float)from[3]};
    return v;
#endif
}

SBI_FORCE_INLINE sbi_mg_sums sbi_mg_add_packed(sbi_mg_sums sums, const int16_t *block, const float *from)
{
    sbi_float4 x = sbi_f4_load(from);
    sums.row[0] += sbi_mg_unpack(block) * x;
    sums.row[1] += sbi_mg_unpack(block + 3) * x;
    sums.row[2] += sbi_mg_unpack(block + 6) * x;
    return sums;
}

SBI_FORCE_INLINE sbi_float4 sbi_mg_finish_packed(sbi_mg_sums even, sbi_mg_sums odd)
{
    return sbi_f4_sums((even.row[0] + odd.row[0]) * (1 / SBI_MG_ONE), (even.row[1] + odd.row[1]) * (1 / SBI_MG_ONE),
                       (even.row[2] + odd.row[2]) * (1 / SBI_MG_ONE));
}
#else
typedef struct sbi_mg_sums {
    float place[9];
} sbi_mg_sums;

SBI_FORCE_INLINE sbi_mg_sums sbi_mg_no_sums(void)
{
    sbi_mg_sums none = {{0, 0, 0, 0, 0, 0, 0, 0, 0}};
    return none;
}

SBI_FORCE_INLINE sbi_mg_sums sbi_mg_add_packed(sbi_mg_sums sums, const int16_t *block, const float *from)
{
    for (int k = 0; k < 9; k++)
        sums.place[k] += (float)block[k] * from[k % 3];
    return sums;
}

SBI_FORCE_INLINE sbi_float4 sbi_mg_finish_packed(sbi_mg_sums even, sbi_mg_sums odd)
{
    for (int k = 0; k < 9; k++)
        even.place[k] += odd.place[k];
    return sbi_mg_finish(even.place, 1 / SBI_MG_ONE);
}
#endif

SBI_FORCE_INLINE sbi_float4 sbi_mg_sum_packed(const int16_t *block, const int *column, const int *end, const float *v)
{
    sbi_mg_sums even = sbi_mg_no_sums(), odd = even;
    for (; column + 1 < end; column += 2, block += 18) {
        SBI_PREFETCH(block, SBI_MG_AHEAD);
        SBI_PREFETCH(column, SBI_MG_AHEAD / 4);
        even = sbi_mg_add_packed(even, block, v + 4 * (size_t)column[0]);
        odd = sbi_mg_add_packed(odd, block + 9, v + 4 * (size_t)column[1]);
    }
    if (column < end)
        even = sbi_mg_add_packed(even, block, v + 4 * (size_t)column[0]);
    return sbi_mg_finish_packed(even, odd);
}

/* ---- packing ---- */

/* An entry times factor, rounded to the nearest; what a matrix that is not positive definite has beyond the range is
 * cut off. */
SBI_FORCE_INLINE int16_t sbi_mg_round(float entry, float factor)
{
    float x = entry * factor;
    x = x < SBI_MG_UNIT ? x : SBI_MG_UNIT; /* also where it is not a number */
    x = x > -SBI_MG_UNIT ? x : -SBI_MG_UNIT;
    return (int16_t)((int)(x + (SBI_MG_UNIT + 1.5f)) - 32768);
}

#if SBI_MG_SSE
SBI_FORCE_INLINE __m128i sbi_mg_round_four(const float *entries, float factor)
{
    __m128 x = _mm_mul_ps(_mm_loadu_ps(entries), _mm_set1_ps(factor));
    x = _mm_max_ps(_mm_min_ps(x, _mm_set1_ps(SBI_MG_UNIT)), _mm_set1_ps(-SBI_MG_UNIT));
    x = _mm_add_ps(x, _mm_set1_ps(SBI_MG_UNIT + 1.5f));
    return _mm_sub_epi32(_mm_cvttps_epi32(x), _mm_set1_epi32(32768));
}
#endif

SBI_FORCE_INLINE void sbi_mg_pack(const float *block, float factor, int16_t *packed)
{
#if SBI_MG_SSE
    __m128i low = sbi_mg_round_four(block, factor), high = sbi_mg_round_four(block + 4, factor);
    _mm_storeu_si128((__m128i *)(void *)packed, _mm_packs_epi32(low, high));
#else
    for (int k = 0; k < 8; k++)
        packed[k] = sbi_mg_round(block[k], factor);
#endif
    packed[8] = sbi_mg_round(block[8], factor);
}

#if !SB_REAL_IS_FLOAT
/* An entry in units of 1 / SBI_MG_WORD, rounded to the nearest, even when it is between two; *bad when it is beyond
 * the range, where it is cut off, or not a number. */
SBI_FORCE_INLINE int32_t sbi_mg_round_word(double x, int *bad)
{
    const double whole = 6755399441055744.0; /* 1.5 * 2^52: what is added to it is rounded to integers */
    *bad |= !(x <= SBI_MG_MAX_WORD && x >= -SBI_MG_MAX_WORD);
    x = x < SBI_MG_MAX_WORD ? x : SBI_MG_MAX_WORD;
    x = x > -SBI_MG_MAX_WORD ? x : -SBI_MG_MAX_WORD;
    return (int32_t)((x + whole) - whole);
}

SBI_FORCE_INLINE void sbi_mg_split(int32_t word, int16_t *packed, uint16_t *rest)
{
    int32_t up = word + 32768;
    *rest = (uint16_t)(up & 65535);
    *packed = (int16_t)((up - (up & 65535)) / 65536);
}

#if SBI_MG_SSE
#if SBI_MG_WIDTH == 128
SBI_FORCE_INLINE __m128i sbi_mg_round_two(const double *entries, double factor, int *bad)
{
    const __m128d most = _mm_set1_pd(SBI_MG_MAX_WORD), least = _mm_set1_pd(-SBI_MG_MAX_WORD);
    __m128d x = _mm_mul_pd(_mm_loadu_pd(entries), _mm_set1_pd(factor));
    *bad |= _mm_movemask_pd(_mm_and_pd(_mm_cmple_pd(x, most), _mm_cmpge_pd(x, least))) != 3;
    return _mm_cvtpd_epi32(_mm_max_pd(_mm_min_pd(x, most), least));
}
#endif

/* Four of sbi_mg_round_word. */
SBI_FORCE_INLINE __m128i sbi_mg_round_words(const double *entries, double factor, int *bad)
{
#if SBI_MG_WIDTH >= 256
    const __m256d most = _mm256_set1_pd(SBI_MG_MAX_WORD), least = _mm256_set1_pd(-SBI_MG_MAX_WORD);
    __m256d x = _mm256_mul_pd(_mm256_loadu_pd(entries), _mm256_set1_pd(factor));
    __m256d inside = _mm256_and_pd(_mm256_cmp_pd(x, most, _CMP_LE_OQ), _mm256_cmp_pd(x, least, _CMP_GE_OQ));
    *bad |= _mm256_movemask_pd(inside) != 15;
    return _mm256_cvtpd_epi32(_mm256_max_pd(_mm256_min_pd(x, most), least));
#else
    __m128i first = sbi_mg_round_two(entries, factor, bad);
    return _mm_unpacklo_epi64(first, sbi_mg_round_two(entries + 2, factor, bad));
#endif
}
#endif

/* A block in 32 bits an entry, by halves. */
SBI_FORCE_INLINE void sbi_mg_pack_words(const sb_real *block, double factor, int16_t *packed, uint16_t *rest, int *bad)
{
#if SBI_MG_SSE
    const __m128i half = _mm_set1_epi32(32768);
    __m128i p = _mm_add_epi32(sbi_mg_round_words(block, factor, bad), half);
    __m128i q = _mm_add_epi32(sbi_mg_round_words(block + 4, factor, bad), half);
    __m128i p_low = _mm_srai_epi32(_mm_slli_epi32(p, 16), 16), q_low = _mm_srai_epi32(_mm_slli_epi32(q, 16), 16);
    _mm_storeu_si128((__m128i *)(void *)rest, _mm_packs_epi32(p_low, q_low));
    _mm_storeu_si128((__m128i *)(void *)packed, _mm_packs_epi32(_mm_srai_epi32(p, 16), _mm_srai_epi32(q, 16)));
#else
    for (int k = 0; k < 8; k++)
        sbi_mg_split(sbi_mg_round_word(block[k] * factor, bad), packed + k, rest + k);
#endif
    sbi_mg_split(sbi_mg_round_word(block[8] * factor, bad), packed + 8, rest + 8);
}
#endif

/* ---- rows in 32 bits an entry ---- */

/* out = a row of words times x: one sum for each place of the blocks, whatever the vectors. The 32768 that is in every
 * word is taken off at the end, from the sum of all x. */
#if SBI_MG_WIDTH >= 256
#if SBI_MG_WIDTH == 512
/* Sums of the first eight places. */
typedef __m512d sbi_mg_words;
SBI_FORCE_INLINE sbi_mg_words sbi_mg_no_words(void) { return _mm512_setzero_pd(); }
SBI_FORCE_INLINE sbi_mg_words sbi_mg_add_words(sbi_mg_words sum, __m128i up, __m128i low, __m256d v)
{
    __m256i words = _mm256_or_si256(_mm256_slli_epi32(_mm256_cvtepi16_epi32(up), 16), _mm256_cvtepu16_epi32(low));
    __m512d x = _mm512_permutexvar_pd(_mm512_setr_epi64(0, 1, 2, 0, 1, 2, 0, 1), _mm512_castpd256_pd512(v));
    return _mm512_add_pd(sum, _mm512_mul_pd(_mm512_cvtepi32_pd(words), x));
}
SBI_FORCE_INLINE void sbi_mg_put_words(double *out, sbi_mg_words sum) { _mm512_storeu_pd(out, sum); }
#else
typedef struct sbi_mg_words {
    __m256d first, second;
} sbi_mg_words;
SBI_FORCE_INLINE sbi_mg_words sbi_mg_no_words(void)
{
    sbi_mg_words sum;
    sum.first = sum.second = _mm256_setzero_pd();
    return sum;
}
SBI_FORCE_INLINE sbi_mg_words sbi_mg_add_words(sbi_mg_words sum, __m128i up, __m128i low, __m256d v)
{
    __m256d a = _mm256_cvtepi32_pd(_mm_unpacklo_epi16(low, up)), b = _mm256_cvtepi32_pd(_mm_unpackhi_epi16(low, up));
    a = _mm256_mul_pd(a, _mm256_permute4x64_pd(v, 0 | 1 << 2 | 2 << 4 | 0 << 6));
    b = _mm256_mul_pd(b, _mm256_permute4x64_pd(v, 1 | 2 << 2 | 0 << 4 | 1 << 6));
    sum.first = _mm256_add_pd(sum.first, a);
    sum.second = _mm256_add_pd(sum.second, b);
    return sum;
}
SBI_FORCE_INLINE void sbi_mg_put_words(double *out, sbi_mg_words sum)
{
    _mm256_storeu_pd(out, sum.first);
    _mm256_storeu_pd(out + 4, sum.second);
}
#endif

/* Words 7 and 8 of a block. */
SBI_FORCE_INLINE __m128d sbi_mg_last_words(const int16_t *packed, const uint16_t *rest)
{
    int32_t up, low;
    memcpy(&up, packed + 7, sizeof up);
    memcpy(&low, rest + 7, sizeof low);
    return _mm_cvtepi32_pd(_mm_unpacklo_epi16(_mm_cvtsi32_si128(low), _mm_cvtsi32_si128(up)));
}

SBI_FORCE_INLINE void sbi_mg_sum_words(const int16_t *packed, const uint16_t *rest, const int *column, const int *end,
                                       const double *x, double s[9], double all[4])
{
    sbi_mg_words sum = sbi_mg_no_words();
    __m256d total = _mm256_setzero_pd();
    __m128d ninth = _mm_setzero_pd();
    double pair[2];
    for (; column < end; column++, packed += 9, rest += 9) {
        const double *from = x + 4 * (size_t)*column;
        __m256d v = _mm256_loadu_pd(from);
        SBI_PREFETCH(packed, SBI_MG_AHEAD);
        SBI_PREFETCH(rest, SBI_MG_AHEAD);
        SBI_PREFETCH(column, SBI_MG_AHEAD / 4);
        sum = sbi_mg_add_words(sum, _mm_loadu_si128((const __m128i *)(const void *)packed),
                               _mm_loadu_si128((const __m128i *)(const void *)rest), v);
        ninth = _mm_add_pd(ninth, _mm_mul_pd(sbi_mg_last_words(packed, rest), _mm_loadu_pd(from + 1)));
        total = _mm256_add_pd(total, v);
    }
    sbi_mg_put_words(s, sum);
    _mm_storeu_pd(pair, ninth);
    s[8] = pair[1];
    _mm256_storeu_pd(all, total);
}
#elif SBI_MG_SSE
/* (sum of the first two, sum of the others) += words k to k + 3 of a block times (x, y), (z, 0). */
SBI_FORCE_INLINE void sbi_mg_add_words(const int16_t *up, const uint16_t *low, __m128d xy, __m128d z, __m128d sum[2])
{
    __m128i words = _mm_unpacklo_epi16(_mm_loadl_epi64((const __m128i *)(const void *)low),
                                       _mm_loadl_epi64((const __m128i *)(const void *)up));
    sum[0] = _mm_add_pd(sum[0], _mm_mul_pd(_mm_cvtepi32_pd(words), xy));
    sum[1] = _mm_add_pd(sum[1], _mm_mul_pd(_mm_cvtepi32_pd(_mm_unpackhi_epi64(words, words)), z));
}

SBI_FORCE_INLINE void sbi_mg_sum_words(const int16_t *packed, const uint16_t *rest, const int *column, const int *end,
                                       const double *x, double s[9], double all[4])
{
    const __m128d none = _mm_setzero_pd();
    __m128d first[2], second[2], third[2], total[2];
    first[0] = first[1] = second[0] = second[1] = third[0] = third[1] = total[0] = total[1] = none;
    for (; column < end; column++, packed += 9, rest += 9) {
        const double *from = x + 4 * (size_t)*column;
        __m128d xy = _mm_loadu_pd(from), z = _mm_loadu_pd(from + 2);
        SBI_PREFETCH(packed, SBI_MG_AHEAD);
        SBI_PREFETCH(rest, SBI_MG_AHEAD);
        sbi_mg_add_words(packed, rest, xy, z, first);
        sbi_mg_add_words(packed + 3, rest + 3, xy, z, second);
        sbi_mg_add_words(packed + 6, rest + 6, xy, z, third);
        total[0] = _mm_add_pd(total[0], xy);
        total[1] = _mm_add_pd(total[1], z);
    }
    _mm_storeu_pd(s, first[0]);
    _mm_store_sd(s + 2, first[1]);
    _mm_storeu_pd(s + 3, second[0]);
    _mm_store_sd(s + 5, second[1]);
    _mm_storeu_pd(s + 6, third[0]);
    _mm_store_sd(s + 8, third[1]);
    _mm_storeu_pd(all, total[0]);
    _mm_storeu_pd(all + 2, total[1]);
}
#else
SBI_FORCE_INLINE void sbi_mg_sum_words(const int16_t *packed, const uint16_t *rest, const int *column, const int *end,
                                       const double *x, double s[9], double all[4])
{
    memset(s, 0, 9 * sizeof(double));
    memset(all, 0, 4 * sizeof(double));
    for (; column < end; column++, packed += 9, rest += 9) {
        const double *from = x + 4 * (size_t)*column;
        for (int k = 0; k < 9; k++)
            s[k] += (double)(packed[k] * 65536 + (int)rest[k]) * from[k % 3];
        for (int k = 0; k < 3; k++)
            all[k] += from[k];
    }
}
#endif

/* ---- rows of a level ---- */

/* D_i^-1 v: the inverse is symmetric. */
SBI_FORCE_INLINE sbi_float4 sbi_mg_relax(const float *inverse, sbi_float4 v) { return sbi_f4_rows(v, inverse); }

/* Row i of A times v. */
SBI_FORCE_INLINE sbi_float4 sbi_mg_multiply_row(const sbi_mg_level *level, int i, const float *v)
{
    const int *column = level->columns + level->row_start[i], *end = level->columns + level->row_start[i + 1];
    size_t first = 9 * (size_t)level->row_start[i];
    sbi_float4 sum;
    if (level->packed)
        sum = sbi_mg_sum_packed(level->packed + first, column, end, v);
    else
        sum = sbi_mg_sum_floats(level->blocks + first, column, end, v);
    if (!level->mend)
        return sum;
    return sbi_f4_add(sum, sbi_mg_relax(level->mend + 12 * (size_t)i, sbi_f4_load(v + 4 * (size_t)i)));
}

#endif /* SB_MULTIGRID_BLOCK_H */
