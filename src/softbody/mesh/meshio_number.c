/* meshio_number: words compared, integers and reals from text, exact to the last bit whatever the C library. */
#include "meshio_reader.h"

#include <float.h>
#include <limits.h>
#include <string.h>

/* ==== numbers ====================================================================================== */

SBI_API int sbi_parse_integer(const char *text, size_t length, int64_t *value)
{
    size_t i = length && (text[0] == '-' || text[0] == '+') ? 1 : 0;
    int negative = i && text[0] == '-';
    uint64_t limit = (uint64_t)INT64_MAX + (negative ? 1u : 0u), magnitude = 0;
    int fits = 1;
    if (i == length)
        return 0;
    for (; i < length; i++) {
        unsigned digit = (unsigned)(unsigned char)text[i] - '0';
        if (digit > 9)
            return 0;
        if (magnitude > (limit - digit) / 10)
            fits = 0;
        else
            magnitude = magnitude * 10 + digit;
    }
    if (!fits)
        return -1;
    *value = negative && magnitude ? -(int64_t)(magnitude - 1) - 1 : (int64_t)magnitude;
    return 1;
}

/* Unsigned integer of up to 3072 bits, least word first, no leading zero words; 0 has no words. */
enum { SBI_BIG_WORDS = 96 };
typedef struct sbi_big {
    uint32_t word[SBI_BIG_WORDS];
    int count;
} sbi_big;

/* a = a * factor + term */
static void sbi_big_multiply(sbi_big *a, uint32_t factor, uint32_t term)
{
    uint64_t carry = term;
    for (int i = 0; i < a->count; i++) {
        carry += (uint64_t)a->word[i] * factor;
        a->word[i] = (uint32_t)carry;
        carry >>= 32;
    }
    if (carry)
        a->word[a->count++] = (uint32_t)carry;
}

static void sbi_big_multiply_pow5(sbi_big *a, int power)
{
    const uint32_t pow5_13 = 1220703125u; /* the largest that fits */
    for (; power >= 13; power -= 13)
        sbi_big_multiply(a, pow5_13, 0);
    for (; power > 0; power--)
        sbi_big_multiply(a, 5, 0);
}

static int sbi_big_bits(const sbi_big *a)
{
    uint32_t top;
    int bits;
    if (a->count == 0)
        return 0;
    bits = (a->count - 1) * 32;
    for (top = a->word[a->count - 1]; top; top >>= 1)
        bits++;
    return bits;
}

static void sbi_big_shift_left(sbi_big *a, int bits)
{
    int words = bits / 32;
    if (bits % 32)
        sbi_big_multiply(a, (uint32_t)1 << (bits % 32), 0);
    if (words == 0 || a->count == 0)
        return;
    memmove(a->word + words, a->word, (size_t)a->count * sizeof a->word[0]);
    memset(a->word, 0, (size_t)words * sizeof a->word[0]);
    a->count += words;
}

/* a -= b and 1 when a >= b; else 0. */
static int sbi_big_take(sbi_big *a, const sbi_big *b)
{
    int64_t borrow = 0;
    int i = a->count - 1;
    if (a->count != b->count) {
        if (a->count < b->count)
            return 0;
    } else {
        while (i >= 0 && a->word[i] == b->word[i])
            i--;
        if (i >= 0 && a->word[i] < b->word[i])
            return 0;
    }
    for (i = 0; i < a->count; i++) {
        int64_t difference = (int64_t)a->word[i] - (i < b->count ? (int64_t)b->word[i] : 0) - borrow;
        borrow = difference < 0;
        a->word[i] = (uint32_t)(difference + (borrow ? (int64_t)1 << 32 : 0));
    }
    while (a->count && a->word[a->count - 1] == 0)
        a->count--;
    return 1;
}

/* quotient 2^exponent rounded to nearest even, with the quotient's top bit set and `sticky` when a
 * remainder is left below it. */
static double sbi_number_round(uint64_t quotient, int sticky, int exponent)
{
    const uint64_t half = (uint64_t)1 << 63;
    int top = exponent + 63;
    int shift = top < -1022 ? 11 - 1022 - top : 11; /* more bits are lost where doubles are subnormal */
    uint64_t mantissa, rest;
    if (top > 1023)
        return HUGE_VAL;
    if (shift > 64)
        return 0;
    mantissa = shift == 64 ? 0 : quotient >> shift;
    rest = shift == 64 ? quotient : quotient << (64 - shift);
    if (rest > half || (rest == half && (sticky || (mantissa & 1))))
        mantissa++;
    return ldexp((double)mantissa, exponent + shift); /* exact: at most 2^53, and already cut to fit */
}

/* numerator / denominator 2^exponent, rounded; schoolbook division, one bit at a time. */
static double sbi_number_divide_big(sbi_big *numerator, sbi_big *denominator, int exponent, int sticky)
{
    int shift = sbi_big_bits(numerator) - sbi_big_bits(denominator);
    uint64_t quotient = 0;
    sbi_big_shift_left(shift < 0 ? numerator : denominator, shift < 0 ? -shift : shift);
    exponent += shift;
    for (int bits = 0; bits < 64;) {
        int one = sbi_big_take(numerator, denominator);
        quotient = quotient << 1 | (uint64_t)one;
        if (quotient)
            bits++;
        else
            exponent--; /* both have the same length, so this happens at most once */
        sbi_big_shift_left(numerator, 1);
    }
    return sbi_number_round(quotient, sticky || numerator->count > 0, exponent - 63);
}

/* The same for 64-bit numbers. */
static double sbi_number_divide(uint64_t numerator, uint64_t denominator, int exponent)
{
    uint64_t quotient = 0;
    int carry = 0;
    for (; !(numerator >> 63); numerator <<= 1)
        exponent--;
    for (; !(denominator >> 63); denominator <<= 1)
        exponent++;
    for (int bits = 0; bits < 64;) {
        int one = carry || numerator >= denominator;
        if (one)
            numerator -= denominator;
        quotient = quotient << 1 | (uint64_t)one;
        if (quotient)
            bits++;
        else
            exponent--;
        carry = (int)(numerator >> 63);
        numerator <<= 1;
    }
    return sbi_number_round(quotient, carry || numerator, exponent - 63);
}

/* A number cut into its parts: value = digits as an integer * 10^exponent. */
typedef struct sbi_decimal {
    int negative;
    const char *digits; /* first significant digit */
    const char *end;    /* behind the last digit; a point may lie between */
    int64_t count;      /* significant digits */
    int64_t exponent;
    uint64_t leading; /* the first 19 significant digits or fewer */
} sbi_decimal;

/* Correctly rounded whatever the number of digits. A double and the middle of two have 767 digits at most,
 * so of those behind 770 only matters whether they are all zero. */
static double sbi_number_from_digits(const sbi_decimal *decimal)
{
    const int kept_max = 770;
    sbi_big numerator, denominator;
    int kept = 0, sticky = 0, exponent;
    numerator.count = denominator.count = 0;
    for (const char *p = decimal->digits; p < decimal->end; p++) {
        if (*p == '.')
            continue;
        if (kept < kept_max) {
            sbi_big_multiply(&numerator, 10, (uint32_t)(*p - '0'));
            kept++;
        } else if (*p != '0') {
            sticky = 1;
        }
    }
    if (decimal->count + decimal->exponent > 310)
        return HUGE_VAL;
    if (decimal->count + decimal->exponent < -330)
        return 0;
    exponent = (int)(decimal->exponent + decimal->count - kept);
    denominator.word[denominator.count++] = 1;
    sbi_big_multiply_pow5(exponent < 0 ? &denominator : &numerator, exponent < 0 ? -exponent : exponent);
    return sbi_number_divide_big(&numerator, &denominator, exponent, sticky);
}

/* Of a number that is not 0; by the fastest way that is exact. */
static double sbi_number_value(const sbi_decimal *decimal)
{
    const uint64_t exact = (uint64_t)1 << 53;
#if defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD == 0
    /* Both are exact doubles, so that one operation rounds once (not so where doubles are kept in wider
     * registers). */
    static const double pow10[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                                   1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};
    if (decimal->count <= 19 && decimal->leading <= exact) {
        if (decimal->exponent >= 0 && decimal->exponent <= 22)
            return (double)decimal->leading * pow10[decimal->exponent];
        if (decimal->exponent < 0 && decimal->exponent >= -22)
            return (double)decimal->leading / pow10[-decimal->exponent];
    }
#endif
    if (decimal->count <= 19 && decimal->exponent <= 0 && decimal->exponent >= -27) {
        uint64_t pow5 = 1; /* 5^27 < 2^63 */
        for (int i = 0; i < -decimal->exponent; i++)
            pow5 *= 5;
        return sbi_number_divide(decimal->leading, pow5, (int)decimal->exponent);
    }
    (void)exact;
    return sbi_number_from_digits(decimal);
}

/* Digits with at most one point; 0 when there is no digit or a second point. */
static int sbi_decimal_digits(sbi_decimal *decimal, const char *text, const char *end)
{
    int point = 0, any = 0;
    decimal->digits = NULL;
    decimal->count = decimal->exponent = 0;
    decimal->leading = 0;
    for (; text < end && ((*text >= '0' && *text <= '9') || (*text == '.' && !point)); text++) {
        if (*text == '.') {
            point = 1;
            continue;
        }
        any = 1;
        decimal->exponent -= point;
        if (!decimal->digits && *text == '0')
            continue;
        if (!decimal->digits)
            decimal->digits = text;
        if (decimal->count++ < 19)
            decimal->leading = decimal->leading * 10 + (uint64_t)(*text - '0');
    }
    decimal->end = text;
    if (!decimal->digits)
        decimal->digits = text;
    return any;
}

static char sbi_reader_lower(char c) { return c >= 'A' && c <= 'Z' ? (char)(c - 'A' + 'a') : c; }

SBI_API int sbi_word_is(sbi_word word, const char *text)
{
    size_t i;
    for (i = 0; i < word.length && text[i]; i++)
        if (sbi_reader_lower(word.text[i]) != sbi_reader_lower(text[i]))
            return 0;
    return i == word.length && !text[i];
}

static int sbi_word_is_not_finite(const char *text, size_t length)
{
    /* The Microsoft spellings are 1.#INF, 1.#QNAN, -1.#IND. */
    static const char names[6][9] = {"nan", "inf", "infinity", "1.#inf", "1.#qnan", "1.#ind"};
    sbi_word word;
    if (length && (text[0] == '-' || text[0] == '+'))
        text++, length--;
    word.text = text;
    word.length = length;
    for (int i = 0; i < 6; i++)
        if (sbi_word_is(word, names[i]))
            return 1;
    word.length = length < 4 ? length : 4;
    return sbi_word_is(word, "nan("); /* nan(ind) */
}

SBI_API int sbi_parse_real(const char *text, size_t length, double *value)
{
    const char *end = text + length;
    sbi_decimal decimal;
    double magnitude;
    const char *start = length && (*text == '-' || *text == '+') ? text + 1 : text;
    decimal.negative = start > text && *text == '-';
    if (!sbi_decimal_digits(&decimal, start, end))
        return sbi_word_is_not_finite(text, length) ? -1 : 0;
    if (decimal.end < end) {
        const char *p = decimal.end;
        int64_t exponent = 0;
        int parsed = *p == 'e' || *p == 'E' ? sbi_parse_integer(p + 1, (size_t)(end - p - 1), &exponent) : 0;
        if (!parsed)
            return sbi_word_is_not_finite(text, length) ? -1 : 0;
        /* An exponent beyond 10^18 wins over any number of digits that fits into memory. */
        if (parsed < 0 || exponent > INT64_MAX / 8 || exponent < -(INT64_MAX / 8))
            exponent = p[1] == '-' ? -(INT64_MAX / 8) : INT64_MAX / 8;
        decimal.exponent += exponent;
    }
    magnitude = decimal.leading ? sbi_number_value(&decimal) : 0;
    if (magnitude > DBL_MAX)
        return -1;
    *value = decimal.negative ? -magnitude : magnitude;
    return 1;
}
