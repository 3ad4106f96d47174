/* meshio_reader: exact number parsing, the bounded reader and the loader that all mesh formats share. */
#include "meshio_reader.h"

#include <float.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
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

/* ==== reader ======================================================================================= */

SBI_API void sbi_reader_init(sbi_reader *reader, const void *data, size_t size, const char *name,
                             sb_error *error)
{
    memset(reader, 0, sizeof *reader);
    reader->data = (const char *)data;
    reader->size = size;
    reader->line = 1;
    reader->node = reader->element = -1;
    reader->name = name ? name : "";
    reader->error = error;
}

SBI_API sb_result sbi_reader_fail(const sbi_reader *reader, sb_result result, const char *format, ...)
{
    char message[200];
    va_list arguments;
    if (!reader->error)
        return result;
    va_start(arguments, format);
    vsnprintf(message, sizeof message, format, arguments);
    va_end(arguments);
    if (reader->binary)
        sbi_fail(reader->error, result, "%s (at byte %llu)", message, (unsigned long long)reader->at);
    else
        sbi_fail(reader->error, result, "%s", message);
    reader->error->line = reader->binary ? 0 : reader->line;
    reader->error->node = reader->node;
    reader->error->element = reader->element;
    sbi_error_set_file(reader->error, reader->name);
    return result;
}

static int sbi_reader_is_blank(char c) { return c == ' ' || c == '\t' || c == '\v' || c == '\f'; }

/* Length of the line end at `at`: LF, CR LF or a lone CR; 0: none. */
static size_t sbi_reader_newline(const sbi_reader *reader, size_t at)
{
    if (at >= reader->size)
        return 0;
    if (reader->data[at] == '\n')
        return 1;
    if (reader->data[at] != '\r')
        return 0;
    return at + 1 < reader->size && reader->data[at + 1] == '\n' ? 2 : 1;
}

static void sbi_reader_count_line(sbi_reader *reader)
{
    if (reader->line < INT_MAX)
        reader->line++;
}

static void sbi_reader_skip_text(sbi_reader *reader)
{
    while (reader->at < reader->size && !sbi_reader_newline(reader, reader->at))
        reader->at++;
}

SBI_API int sbi_reader_at_line_end(sbi_reader *reader)
{
    while (reader->at < reader->size) {
        char c = reader->data[reader->at];
        if (sbi_reader_is_blank(c)) {
            reader->at++;
        } else if (c == '\\' && reader->continuation && sbi_reader_newline(reader, reader->at + 1)) {
            reader->at += 1 + sbi_reader_newline(reader, reader->at + 1);
            sbi_reader_count_line(reader);
        } else {
            break;
        }
    }
    if (reader->comment && reader->at < reader->size && reader->data[reader->at] == reader->comment)
        sbi_reader_skip_text(reader);
    return reader->at >= reader->size || sbi_reader_newline(reader, reader->at);
}

SBI_API void sbi_reader_next_line(sbi_reader *reader)
{
    sbi_reader_skip_text(reader);
    if (reader->at < reader->size) {
        reader->at += sbi_reader_newline(reader, reader->at);
        sbi_reader_count_line(reader);
    }
}

SBI_API sb_result sbi_reader_check_text(sbi_reader *reader)
{
    sbi_reader ahead;
    const char *nul;
    if (sbi_reader_left(reader) > 0 && reader->data[reader->size - 1] == 0)
        reader->size--;
    nul = sbi_reader_left(reader) ? (const char *)memchr(reader->data + reader->at, 0, sbi_reader_left(reader)) : NULL;
    if (!nul)
        return SB_OK;
    ahead = *reader;
    ahead.size = (size_t)(nul - reader->data);
    while (ahead.at < ahead.size)
        sbi_reader_next_line(&ahead);
    return sbi_reader_fail(&ahead, SB_ERROR_FORMAT, "a NUL byte: the file is damaged, or no text in UTF-8");
}

SBI_API int sbi_reader_line_word(sbi_reader *reader, sbi_word *word)
{
    size_t start;
    if (sbi_reader_at_line_end(reader))
        return 0;
    start = reader->at;
    while (reader->at < reader->size) {
        char c = reader->data[reader->at];
        if (sbi_reader_is_blank(c) || c == '\n' || c == '\r' || (reader->comment && c == reader->comment))
            break;
        if (c == '\\' && reader->continuation && sbi_reader_newline(reader, reader->at + 1))
            break;
        reader->at++;
    }
    word->text = reader->data + start;
    word->length = reader->at - start;
    return 1;
}

SBI_API int sbi_reader_word(sbi_reader *reader, sbi_word *word)
{
    while (!sbi_reader_line_word(reader, word)) {
        if (reader->at >= reader->size)
            return 0;
        sbi_reader_next_line(reader);
    }
    return 1;
}

SBI_API int sbi_reader_peek(const sbi_reader *reader, sbi_word *word)
{
    sbi_reader copy = *reader;
    return sbi_reader_word(&copy, word);
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

SBI_API int sbi_word_equals(sbi_word word, const char *text)
{
    return strlen(text) == word.length && memcmp(word.text, text, word.length) == 0;
}

SBI_API const char *sbi_word_print(sbi_word word, char buffer[32])
{
    size_t length = word.length < 31 ? word.length : 31;
    for (size_t i = 0; i < length; i++)
        buffer[i] = word.text[i] >= ' ' && word.text[i] <= '~' ? word.text[i] : '?';
    buffer[length] = 0;
    return buffer;
}

static sb_result sbi_reader_fail_word(const sbi_reader *reader, const char *what, sbi_word word,
                                      const char *why)
{
    char text[32];
    return sbi_reader_fail(reader, SB_ERROR_FORMAT, "%s: '%s' %s", what, sbi_word_print(word, text), why);
}

SBI_API sb_result sbi_reader_integer(sbi_reader *reader, const char *what, int64_t *value)
{
    sbi_word word;
    int parsed;
    if (!sbi_reader_word(reader, &word))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends where %s should be", what);
    parsed = sbi_parse_integer(word.text, word.length, value);
    if (parsed > 0)
        return SB_OK;
    return sbi_reader_fail_word(reader, what, word, parsed ? "is too large" : "is not an integer");
}

SBI_API sb_result sbi_reader_real(sbi_reader *reader, const char *what, double *value)
{
    sbi_word word;
    char text[32];
    int parsed;
    if (!sbi_reader_word(reader, &word))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends where %s should be", what);
    parsed = sbi_parse_real(word.text, word.length, value);
    if (parsed > 0)
        return SB_OK;
    if (parsed == 0)
        return sbi_reader_fail_word(reader, what, word, "is not a number");
    return sbi_reader_fail(reader, SB_ERROR_NOT_FINITE, "%s: '%s' is not finite", what,
                           sbi_word_print(word, text));
}

SBI_API sb_result sbi_reader_check_count(const sbi_reader *reader, const char *what, int64_t value,
                                         size_t bytes, int *count)
{
    if (value < 0)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "%s is negative: %lld", what, (long long)value);
    if (value > INT_MAX)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "%s is larger than 2147483647: %lld", what,
                               (long long)value);
    /* + 1: in a text the last blank may be missing */
    if (bytes && (uint64_t)value > ((uint64_t)sbi_reader_left(reader) + 1) / bytes)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "%s is %lld, but the file is too short for that",
                               what, (long long)value);
    *count = (int)value;
    return SB_OK;
}

SBI_API sb_result sbi_reader_count(sbi_reader *reader, const char *what, size_t bytes, int *count)
{
    int64_t value = 0;
    sb_result result = sbi_reader_integer(reader, what, &value);
    return result ? result : sbi_reader_check_count(reader, what, value, bytes, count);
}

SBI_API sb_result sbi_reader_skip_words(sbi_reader *reader, size_t count, const char *what)
{
    sbi_word word;
    for (size_t i = 0; i < count; i++)
        if (!sbi_reader_word(reader, &word))
            return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends in %s", what);
    return SB_OK;
}

SBI_API const unsigned char *sbi_reader_bytes(sbi_reader *reader, size_t count, size_t size, const char *what)
{
    const char *bytes = reader->data + reader->at;
    if (size && count > sbi_reader_left(reader) / size) {
        sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends in %s", what);
        return NULL;
    }
    reader->at += count * size;
    return (const unsigned char *)bytes;
}

SBI_API uint64_t sbi_decode_bits(const sbi_reader *reader, const unsigned char *bytes, int size)
{
    uint64_t bits = 0;
    for (int i = 0; i < size; i++)
        bits = bits << 8 | bytes[reader->big_endian ? i : size - 1 - i];
    return bits;
}

SBI_API int64_t sbi_decode_signed(const sbi_reader *reader, const unsigned char *bytes, int size)
{
    uint64_t bits = sbi_decode_bits(reader, bytes, size);
    uint64_t sign = (uint64_t)1 << (8 * size - 1);
    if (!(bits & sign))
        return (int64_t)bits;
    /* the magnitude of a negative number, less one so that it fits */
    return -(int64_t)((sign - 1) - (bits & (sign - 1))) - 1;
}

SBI_API double sbi_decode_float(const sbi_reader *reader, const unsigned char *bytes, int size)
{
    uint64_t bits = sbi_decode_bits(reader, bytes, size);
    uint32_t low = (uint32_t)bits;
    float single;
    double value;
    if (size == 4) {
        memcpy(&single, &low, sizeof single);
        return (double)single;
    }
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* Merges [first, middle) and [middle, end) of `from` into `to`. */
static void sbi_merge_runs(const int *from, int *to, int first, int middle, int end, sbi_before before,
                           const void *context)
{
    int left = first, right = middle;
    for (int i = first; i < end; i++) {
        int take_right = left >= middle || (right < end && before(context, from[right], from[left]));
        to[i] = take_right ? from[right++] : from[left++];
    }
}

SBI_API void sbi_merge_sort(int *order, int *scratch, int count, sbi_before before, const void *context)
{
    int *from = order, *to = scratch;
    for (int64_t width = 1; width < count; width *= 2) {
        int *swap = from;
        for (int64_t first = 0; first < count; first += 2 * width) {
            int64_t middle = first + width < count ? first + width : count;
            int64_t end = middle + width < count ? middle + width : count;
            sbi_merge_runs(from, to, (int)first, (int)middle, (int)end, before, context);
        }
        from = to;
        to = swap;
    }
    if (from != order)
        memcpy(order, from, (size_t)count * sizeof order[0]);
}

/* ==== cells ======================================================================================== */

SBI_API const sbi_cell_kind *sbi_cell_kind_at(int kind)
{
    static const sbi_cell_kind kinds[SBI_CELL_KINDS] = {
        {"tri3", SB_TRI3, 2, 3, 5, 2, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"quad4", SB_QUAD4, 2, 4, 9, 3, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tet4", SB_TET4, 3, 4, 10, 4, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_TET},
        {"tet10", SB_TET10, 3, 10, 24, 11, SBI_ORDER_SAME, SBI_ORDER_GMSH_TET10, SBI_SHAPE_TET},
        {"hex8", SB_HEX8, 3, 8, 12, 5, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_HEX},
        {"tri6", SB_TRI6, 2, 6, 22, 9, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"pixel", SB_QUAD4, 2, 4, 8, -1, SBI_ORDER_PIXEL, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"voxel", SB_HEX8, 3, 8, 11, -1, SBI_ORDER_VOXEL, SBI_ORDER_SAME, SBI_SHAPE_HEX},
        {"empty cell", SB_NO_ELEMENT, 0, 0, 0, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"vertex", SB_NO_ELEMENT, 0, 1, 1, 15, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"polyvertex", SB_NO_ELEMENT, 0, 0, 2, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"line2", SB_NO_ELEMENT, 1, 2, 3, 1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"polyline", SB_NO_ELEMENT, 1, 0, 4, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"line3", SB_NO_ELEMENT, 1, 3, 21, 8, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"line4", SB_NO_ELEMENT, 1, 4, 35, 26, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"line5", SB_NO_ELEMENT, 1, 5, -1, 27, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"line6", SB_NO_ELEMENT, 1, 6, -1, 28, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"Lagrange curve", SB_NO_ELEMENT, 1, 0, 68, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"triangle strip", SB_NO_ELEMENT, 2, 0, 6, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"polygon", SB_NO_ELEMENT, 2, 0, 7, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tri7", SB_NO_ELEMENT, 2, 7, 34, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tri9", SB_NO_ELEMENT, 2, 9, -1, 20, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tri10", SB_NO_ELEMENT, 2, 10, -1, 21, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tri12", SB_NO_ELEMENT, 2, 12, -1, 22, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tri15", SB_NO_ELEMENT, 2, 15, -1, 23, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tri15 (order 5)", SB_NO_ELEMENT, 2, 15, -1, 24, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tri21", SB_NO_ELEMENT, 2, 21, -1, 25, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"quad6", SB_NO_ELEMENT, 2, 6, 30, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"quad8", SB_QUAD8, 2, 8, 23, 16, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"quad9", SB_QUAD9, 2, 9, 28, 10, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"quadratic polygon", SB_NO_ELEMENT, 2, 0, 36, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"Lagrange triangle", SB_NO_ELEMENT, 2, 0, 69, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"Lagrange quadrilateral", SB_NO_ELEMENT, 2, 0, 70, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tet20", SB_NO_ELEMENT, 3, 20, -1, 29, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tet35", SB_NO_ELEMENT, 3, 35, -1, 30, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"tet56", SB_NO_ELEMENT, 3, 56, -1, 31, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"hex20", SB_HEX20, 3, 20, 25, 17, SBI_ORDER_SAME, SBI_ORDER_GMSH_HEX, SBI_SHAPE_HEX},
        {"hex24", SB_NO_ELEMENT, 3, 24, 33, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"hex27", SB_HEX27, 3, 27, 29, 12, SBI_ORDER_SAME, SBI_ORDER_GMSH_HEX, SBI_SHAPE_HEX},
        {"hex64", SB_NO_ELEMENT, 3, 64, -1, 92, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"hex125", SB_NO_ELEMENT, 3, 125, -1, 93, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"wedge6", SB_NO_ELEMENT, 3, 6, 13, 6, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_WEDGE},
        {"wedge12", SB_NO_ELEMENT, 3, 12, 31, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"wedge15", SB_NO_ELEMENT, 3, 15, 26, 18, SBI_ORDER_SAME, SBI_ORDER_GMSH_WEDGE, SBI_SHAPE_WEDGE},
        {"wedge18", SB_NO_ELEMENT, 3, 18, 32, 13, SBI_ORDER_SAME, SBI_ORDER_GMSH_WEDGE, SBI_SHAPE_WEDGE},
        {"pyramid5", SB_NO_ELEMENT, 3, 5, 14, 7, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_PYRAMID},
        {"pyramid13", SB_NO_ELEMENT, 3, 13, 27, 19, SBI_ORDER_SAME, SBI_ORDER_GMSH_PYRAMID, SBI_SHAPE_PYRAMID},
        {"pyramid14", SB_NO_ELEMENT, 3, 14, -1, 14, SBI_ORDER_SAME, SBI_ORDER_GMSH_PYRAMID, SBI_SHAPE_PYRAMID},
        {"pentagonal prism", SB_NO_ELEMENT, 3, 10, 15, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"hexagonal prism", SB_NO_ELEMENT, 3, 12, 16, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"convex point set", SB_NO_ELEMENT, 3, 0, 41, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"polyhedron", SB_NO_ELEMENT, 3, 0, 42, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"Lagrange tetrahedron", SB_NO_ELEMENT, 3, 0, 71, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"Lagrange hexahedron", SB_NO_ELEMENT, 3, 0, 72, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
        {"Lagrange wedge", SB_NO_ELEMENT, 3, 0, 73, -1, SBI_ORDER_SAME, SBI_ORDER_SAME, SBI_SHAPE_NONE},
    };
    return &kinds[kind];
}

SBI_API int sbi_cell_kind_of_vtk(int64_t number)
{
    for (int kind = 0; number >= 0 && kind < SBI_CELL_KINDS; kind++)
        if (sbi_cell_kind_at(kind)->vtk == number)
            return kind;
    return -1;
}

SBI_API int sbi_cell_kind_of_gmsh(int64_t number)
{
    for (int kind = 0; number >= 0 && kind < SBI_CELL_KINDS; kind++)
        if (sbi_cell_kind_at(kind)->gmsh == number)
            return kind;
    return -1;
}

/* Position in the file's list of our node i. */
static int sbi_node_order_at(sbi_node_order order, int i)
{
    static const unsigned char voxel[8] = {0, 1, 3, 2, 4, 5, 7, 6}; /* its first four are a pixel's */
    static const unsigned char gmsh_tet10[10] = {0, 1, 2, 3, 4, 5, 6, 7, 9, 8};
    static const unsigned char gmsh_hex[27] = {0,  1,  2,  3,  4,  5,  6,  7,  8,  11, 13, 9,  16, 18,
                                               19, 17, 10, 12, 14, 15, 22, 23, 21, 24, 20, 25, 26};
    static const unsigned char gmsh_wedge[18] = {0, 1, 2, 3, 4, 5, 6, 9, 7, 12, 14, 13, 8, 10, 11, 15, 17, 16};
    static const unsigned char gmsh_pyramid[14] = {0, 1, 2, 3, 4, 5, 8, 10, 6, 7, 9, 11, 12, 13};
    switch (order) {
    case SBI_ORDER_PIXEL:
    case SBI_ORDER_VOXEL: return voxel[i];
    case SBI_ORDER_GMSH_TET10: return gmsh_tet10[i];
    case SBI_ORDER_GMSH_HEX: return gmsh_hex[i];
    case SBI_ORDER_GMSH_WEDGE: return gmsh_wedge[i];
    case SBI_ORDER_GMSH_PYRAMID: return gmsh_pyramid[i];
    case SBI_ORDER_SAME: break;
    }
    return i;
}

/* ==== loader ======================================================================================= */

SBI_API void sbi_loader_init(sbi_loader *loader, const sb_load_options *options, sb_error *error)
{
    memset(loader, 0, sizeof *loader);
    sbi_reader_init(&loader->reader, "", 0, "", error);
    loader->allocator = options->allocator;
    loader->scale = (double)options->scale;
    loader->keep_low = options->sets != NULL;
}

SBI_API void sbi_loader_free(sbi_loader *loader)
{
    sbi_free(&loader->allocator, loader->nodes);
    sbi_free(&loader->allocator, loader->normals);
    sbi_free(&loader->allocator, loader->indices);
    sbi_free(&loader->allocator, loader->cells);
    sbi_free(&loader->allocator, loader->scratch);
    sbi_free(&loader->allocator, loader->source_regions);
    sbi_free(&loader->allocator, loader->groups);
    sbi_free(&loader->allocator, loader->names);
    sbi_free(&loader->allocator, loader->diagonals);
}

SBI_API sb_result sbi_loader_no_memory(const sbi_loader *loader)
{
    sbi_fail(loader->reader.error, SB_ERROR_MEMORY, "out of memory while loading a mesh");
    if (loader->reader.error)
        sbi_error_set_file(loader->reader.error, loader->reader.name);
    return SB_ERROR_MEMORY;
}

SBI_API void *sbi_loader_grow(const sbi_loader *loader, void *old, size_t used, size_t *capacity,
                              size_t needed, size_t item)
{
    size_t target = *capacity < ((size_t)-1) / 2 ? 2 * *capacity : needed;
    void *grown;
    if (target < needed)
        target = needed;
    if (target < 16)
        target = 16;
    grown = sbi_alloc(&loader->allocator, target, item);
    if (!grown)
        return NULL;
    if (used)
        memcpy(grown, old, used * item);
    sbi_free(&loader->allocator, old);
    *capacity = target;
    return grown;
}

static int sbi_loader_room_for_nodes(sbi_loader *loader, size_t needed)
{
    void *grown = loader->nodes;
    if (needed > loader->node_capacity)
        grown = sbi_loader_grow(loader, loader->nodes, loader->node_count, &loader->node_capacity, needed,
                                sizeof loader->nodes[0]);
    if (grown)
        loader->nodes = (sb_vec3 *)grown;
    return grown != NULL;
}

SBI_API sb_result sbi_loader_reserve_nodes(sbi_loader *loader, int count)
{
    size_t needed = loader->node_count + (size_t)count;
    return count == 0 || sbi_loader_room_for_nodes(loader, needed) ? SB_OK : sbi_loader_no_memory(loader);
}

SBI_API sb_result sbi_loader_add_node(sbi_loader *loader, const double x[3])
{
    sb_real scaled[3];
    sbi_reader *reader = &loader->reader;
    reader->node = (int)loader->node_count;
    for (int i = 0; i < 3; i++) {
        double value = x[i] * loader->scale;
        if (x[i] - x[i] != 0)
            return sbi_reader_fail(reader, SB_ERROR_NOT_FINITE, "a coordinate of node %d is not finite",
                                   reader->node);
        if (fabs(value) > (double)SB_REAL_MAX)
            return sbi_reader_fail(reader, SB_ERROR_NOT_FINITE, "a coordinate of node %d is too large: %g",
                                   reader->node, value);
        scaled[i] = (sb_real)value;
    }
    if (loader->node_count >= INT_MAX)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 nodes");
    if (loader->node_count >= loader->node_capacity &&
        !sbi_loader_room_for_nodes(loader, loader->node_count + 1))
        return sbi_loader_no_memory(loader);
    loader->nodes[loader->node_count++] = sb_v3(scaled[0], scaled[1], scaled[2]);
    reader->node = -1;
    return SB_OK;
}

SBI_API sb_result sbi_loader_add_normal(sbi_loader *loader, const double n[3])
{
    sb_vec3 normal = sb_v3((sb_real)n[0], (sb_real)n[1], (sb_real)n[2]);
    if (!sb_v3_is_finite(normal))
        return sbi_reader_fail(&loader->reader, SB_ERROR_NOT_FINITE, "normal %llu is not finite",
                               (unsigned long long)loader->normal_count);
    if (loader->normal_count >= loader->normal_capacity) {
        size_t needed = loader->normal_count + 1;
        void *grown = sbi_loader_grow(loader, loader->normals, loader->normal_count, &loader->normal_capacity,
                                      needed > loader->node_capacity ? needed : loader->node_capacity,
                                      sizeof loader->normals[0]);
        if (!grown)
            return sbi_loader_no_memory(loader);
        loader->normals = (sb_vec3 *)grown;
    }
    loader->normals[loader->normal_count++] = normal;
    return SB_OK;
}

SBI_API sb_result sbi_loader_read_node(sbi_loader *loader)
{
    double x[3] = {0, 0, 0};
    loader->reader.node = (int)loader->node_count;
    for (int i = 0; i < 3; i++) {
        sb_result result = sbi_reader_real(&loader->reader, "coordinate", &x[i]);
        if (result)
            return result;
    }
    return sbi_loader_add_node(loader, x);
}

SBI_API void sbi_loader_begin_cell(sbi_loader *loader)
{
    loader->scratch_count = 0;
    loader->reader.element = loader->source_count;
}

SBI_API sb_result sbi_loader_cell_node(sbi_loader *loader, int64_t number, int64_t base)
{
    int64_t last = base + (int64_t)loader->node_count - 1;
    if (loader->node_count == 0)
        return sbi_reader_fail(&loader->reader, SB_ERROR_INDEX, "a cell before the first node");
    if (number < base || number > last)
        return sbi_reader_fail(&loader->reader, SB_ERROR_INDEX,
                               "node %lld does not exist: nodes are %lld to %lld", (long long)number,
                               (long long)base, (long long)last);
    if (loader->scratch_count >= loader->scratch_capacity) {
        void *grown =
            sbi_loader_grow(loader, loader->scratch, loader->scratch_count, &loader->scratch_capacity,
                            loader->scratch_count + 1, sizeof loader->scratch[0]);
        if (!grown)
            return sbi_loader_no_memory(loader);
        loader->scratch = (int *)grown;
    }
    loader->scratch[loader->scratch_count++] = (int)(number - base);
    return SB_OK;
}

/* Room for one more cell of `nodes` nodes. */
static sb_result sbi_loader_reserve_cell(sbi_loader *loader, size_t nodes)
{
    void *grown;
    if (loader->cell_count >= INT_MAX)
        return sbi_reader_fail(&loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 elements");
    if (loader->cell_count >= loader->cell_capacity) {
        grown = sbi_loader_grow(loader, loader->cells, loader->cell_count, &loader->cell_capacity,
                                loader->cell_count + 1, sizeof loader->cells[0]);
        if (!grown)
            return sbi_loader_no_memory(loader);
        loader->cells = (sbi_cell *)grown;
    }
    if (nodes > loader->index_capacity - loader->index_count) {
        grown = sbi_loader_grow(loader, loader->indices, loader->index_count, &loader->index_capacity,
                                loader->index_count + nodes, sizeof loader->indices[0]);
        if (!grown)
            return sbi_loader_no_memory(loader);
        loader->indices = (int *)grown;
    }
    return SB_OK;
}

/* Appends a cell with the nodes scratch[a], scratch[b], ... or, with corners NULL, all of them in `order`. */
static sb_result sbi_loader_push_cell(sbi_loader *loader, int kind, const size_t corners[3],
                                      sbi_node_order order, int region)
{
    int nodes = sbi_cell_kind_at(kind)->nodes;
    sb_result result = sbi_loader_reserve_cell(loader, (size_t)nodes);
    sbi_cell *cell;
    if (result)
        return result;
    cell = &loader->cells[loader->cell_count++];
    cell->kind = kind;
    cell->source = loader->source_count;
    cell->region = region;
    cell->groups = loader->cell_groups;
    for (int i = 0; i < nodes; i++) {
        size_t from = corners ? corners[i] : (size_t)sbi_node_order_at(order, i);
        loader->indices[loader->index_count++] = loader->scratch[from];
    }
    return SB_OK;
}

/* Counts a finished cell of the file. */
static sb_result sbi_loader_count_cell(sbi_loader *loader, int kind)
{
    if (loader->source_count == INT_MAX)
        return sbi_reader_fail(&loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 cells");
    if (loader->kind_count[kind]++ == 0) {
        loader->kind_line[kind] = loader->reader.binary ? 0 : loader->reader.line;
        loader->kind_first[kind] = loader->source_count;
    }
    loader->source_count++;
    loader->reader.element = -1;
    return SB_OK;
}

/* Cells that may become elements, or for the sake of sets points and lines. */
static int sbi_loader_keeps(const sbi_loader *loader, const sbi_cell_kind *about)
{
    if (about->dimension < 2)
        return loader->keep_low && about->nodes > 0;
    return about->type != SB_NO_ELEMENT || about->shape != SBI_SHAPE_NONE;
}

SBI_API sb_result sbi_loader_end_cell(sbi_loader *loader, int kind, sbi_node_order order, int region)
{
    const sbi_cell_kind *about = sbi_cell_kind_at(kind);
    sb_result result = SB_OK;
    if (about->nodes && loader->scratch_count != (size_t)about->nodes)
        return sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "cell %d has %llu nodes, but a %s has %d",
                               loader->source_count, (unsigned long long)loader->scratch_count, about->name,
                               about->nodes);
    if (sbi_loader_keeps(loader, about))
        result = sbi_loader_push_cell(loader, kind, NULL, order, region);
    return result ? result : sbi_loader_count_cell(loader, kind);
}

static sb_result sbi_loader_end_triangles(sbi_loader *loader, int region, int strip)
{
    sb_result result = SB_OK;
    size_t count = loader->scratch_count;
    if (count < 3)
        return sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "face %d has %llu corners",
                               loader->source_count, (unsigned long long)count);
    for (size_t i = 0; i + 2 < count && !result; i++) {
        size_t fan[3], odd = strip ? i % 2 : 0;
        fan[0] = strip ? i : 0;
        fan[1] = i + 1 + odd; /* every other triangle of a strip turns round */
        fan[2] = i + 2 - odd;
        result = sbi_loader_push_cell(loader, SBI_CELL_TRI3, fan, SBI_ORDER_SAME, region);
    }
    if (!result && count > 3)
        loader->split_polygons++;
    return result ? result : sbi_loader_count_cell(loader, SBI_CELL_TRI3);
}

SBI_API sb_result sbi_loader_end_polygon(sbi_loader *loader, int region)
{
    return sbi_loader_end_triangles(loader, region, 0);
}

SBI_API sb_result sbi_loader_end_strip(sbi_loader *loader, int region)
{
    return sbi_loader_end_triangles(loader, region, 1);
}

SBI_API sb_result sbi_loader_end_vtk_cell(sbi_loader *loader, int kind)
{
    const sbi_cell_kind *about = sbi_cell_kind_at(kind);
    if (about->vtk == 7)
        return sbi_loader_end_polygon(loader, 0);
    if (about->vtk == 6)
        return sbi_loader_end_strip(loader, 0);
    return sbi_loader_end_cell(loader, kind, about->vtk_order, 0);
}

/* ---- groups, regions and what is left out ---- */

SBI_API sb_result sbi_loader_add_groups(sbi_loader *loader, const int *numbers, int count, int *list)
{
    size_t used = loader->group_count ? loader->group_count : 1, needed = used + (size_t)count + 1;
    const int *before = loader->cell_groups ? loader->groups + loader->cell_groups : NULL;
    *list = 0;
    if (count == 0)
        return SB_OK;
    if (before && before[0] == count && memcmp(before + 1, numbers, (size_t)count * sizeof(int)) == 0) {
        *list = loader->cell_groups;
        return SB_OK;
    }
    if (needed > INT_MAX)
        return sbi_reader_fail(&loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 groups");
    if (needed > loader->group_capacity) {
        void *grown = sbi_loader_grow(loader, loader->groups, loader->group_count, &loader->group_capacity, needed,
                                      sizeof loader->groups[0]);
        if (!grown)
            return sbi_loader_no_memory(loader);
        loader->groups = (int *)grown;
    }
    loader->groups[0] = 0;
    loader->groups[used] = count;
    memcpy(loader->groups + used + 1, numbers, (size_t)count * sizeof(int));
    loader->group_count = needed;
    *list = (int)used;
    return SB_OK;
}

/* Copies a name, cut where it is too long, never within a character of UTF-8. */
static void sbi_name_copy(char *to, size_t room, sbi_word text)
{
    size_t length = text.length < room ? text.length : room - 1;
    if (length < text.length)
        while (length > 0 && ((unsigned char)text.text[length] & 0xC0) == 0x80)
            length--;
    for (size_t i = 0; i < length; i++)
        to[i] = (unsigned char)text.text[i] < ' ' || text.text[i] == 127 ? '?' : text.text[i];
    to[length] = 0;
}

SBI_API sb_result sbi_loader_add_name(sbi_loader *loader, int dimension, int number, sbi_word text)
{
    sbi_group_name *name;
    if (loader->name_count >= loader->name_capacity) {
        void *grown = sbi_loader_grow(loader, loader->names, loader->name_count, &loader->name_capacity,
                                      loader->name_count + 1, sizeof loader->names[0]);
        if (!grown)
            return sbi_loader_no_memory(loader);
        loader->names = (sbi_group_name *)grown;
    }
    name = &loader->names[loader->name_count++];
    name->dimension = dimension;
    name->number = number;
    sbi_name_copy(name->text, sizeof name->text, text);
    return SB_OK;
}

SBI_API void sbi_loader_ignore(sbi_loader *loader, sbi_word name)
{
    char text[40];
    size_t used = strlen(loader->ignored), length;
    sbi_name_copy(text, sizeof text, name);
    length = strlen(text);
    if (loader->ignored_count < INT_MAX)
        loader->ignored_count++;
    if (used + length + 6 >= sizeof loader->ignored) { /* room for the dots is kept */
        if (used < 3 || strcmp(loader->ignored + used - 3, "...") != 0)
            memcpy(loader->ignored + used, used ? ", ..." : "...", used ? 6 : 4);
        return;
    }
    if (used) {
        memcpy(loader->ignored + used, ", ", 2);
        used += 2;
    }
    memcpy(loader->ignored + used, text, length + 1);
}

/* The names that programs give to the material of a cell; ours is best. */
SBI_API int sbi_region_field_rank(sbi_word name)
{
    static const char names[][20] = {"region",       "regions",      "region_id",  "RegionId",      "material",
                                     "materials",    "material_id",  "MaterialId", "MaterialIds",   "mat_id",
                                     "gmsh:physical", "medit:ref",   "CellEntityIds"};
    const int count = (int)(sizeof names / sizeof names[0]);
    for (int i = 0; i < count; i++)
        if (sbi_word_is(name, names[i]))
            return count - i;
    return 0;
}

SBI_API int sbi_loader_choose_regions(sbi_loader *loader, sbi_word name, int usable)
{
    int rank = usable ? sbi_region_field_rank(name) : 0;
    sbi_word before;
    if (rank <= loader->region_rank) {
        sbi_loader_ignore(loader, name);
        return 0;
    }
    before.text = loader->region_field;
    before.length = strlen(loader->region_field);
    if (loader->region_rank)
        sbi_loader_ignore(loader, before);
    loader->region_rank = rank;
    sbi_name_copy(loader->region_field, sizeof loader->region_field, name);
    return 1;
}

SBI_API sb_result sbi_loader_begin_regions(sbi_loader *loader)
{
    size_t count = (size_t)loader->source_count, before = (size_t)loader->region_cells;
    int *grown;
    if (loader->source_regions && count == before)
        return SB_OK;
    grown = (int *)sbi_alloc_zeroed(&loader->allocator, count, sizeof(int));
    if (!grown)
        return sbi_loader_no_memory(loader);
    if (loader->source_regions && before)
        memcpy(grown, loader->source_regions, before * sizeof(int));
    sbi_free(&loader->allocator, loader->source_regions);
    loader->source_regions = grown;
    loader->region_cells = loader->source_count;
    return SB_OK;
}

SBI_API sb_result sbi_loader_set_region(sbi_loader *loader, sbi_word name, int cell, double value)
{
    if (loader->region_rank == 0)
        return SB_OK;
    if (value >= INT_MIN && value <= INT_MAX && value == (double)(int)value) {
        loader->source_regions[cell] = (int)value;
        return SB_OK;
    }
    if (sbi_word_is(name, "region"))
        return sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "the region of cell %d is not an integer: %g", cell,
                               value);
    loader->region_rank = 0;
    memset(loader->source_regions, 0, (size_t)loader->region_cells * sizeof(int));
    sbi_loader_ignore(loader, name);
    return SB_OK;
}

/* ---- from cells to one element type ---- */

SBI_API sb_result sbi_loader_fail_kind(const sbi_loader *loader, int kind, const char *format,
                                       const char *first, const char *second)
{
    sbi_reader place = loader->reader;
    char message[160];
    place.line = loader->kind_line[kind];
    place.binary = 0;
    place.element = loader->kind_first[kind];
    snprintf(message, sizeof message, "%s%s%s", first, format, second);
    return sbi_reader_fail(&place, SB_ERROR_UNSUPPORTED, "%s", message);
}

/* The highest dimension in the file; counts the cells below it. */
static int sbi_loader_find_dimension(sbi_loader *loader)
{
    int dimension = 0;
    for (int kind = 0; kind < SBI_CELL_KINDS; kind++)
        if (loader->kind_count[kind] && sbi_cell_kind_at(kind)->dimension > dimension)
            dimension = sbi_cell_kind_at(kind)->dimension;
    loader->skipped_cells = 0;
    for (int kind = 0; kind < SBI_CELL_KINDS; kind++)
        if (sbi_cell_kind_at(kind)->dimension < dimension)
            loader->skipped_cells += loader->kind_count[kind];
    return dimension;
}

static int sbi_loader_is_flat_pair(sb_element_type a, sb_element_type b)
{
    return (a == SB_TRI3 && b == SB_QUAD4) || (a == SB_QUAD4 && b == SB_TRI3);
}

/* The one element type of the cells of the dimension; tri3 where triangles are mixed with quadrilaterals. */
static sb_result sbi_loader_find_type(const sbi_loader *loader, int dimension, sb_element_type *type)
{
    int first = -1;
    for (int kind = 0; kind < SBI_CELL_KINDS; kind++) {
        const sbi_cell_kind *about = sbi_cell_kind_at(kind);
        if (!loader->kind_count[kind] || about->dimension != dimension)
            continue;
        if (about->type == SB_NO_ELEMENT && about->shape == SBI_SHAPE_NONE)
            return sbi_loader_fail_kind(loader, kind, " elements are not supported", about->name, "");
        if (first < 0) {
            first = kind;
            *type = about->type;
        } else if (sbi_loader_is_flat_pair(*type, about->type)) {
            *type = SB_TRI3;
        } else if (*type != about->type || *type == SB_NO_ELEMENT) {
            return sbi_loader_fail_kind(loader, kind, " and ", sbi_cell_kind_at(first)->name, about->name);
        }
    }
    return SB_OK;
}

/* Quadrilaterals among triangles are two; volume cells that are cut are 1, 2, 3 or 6 tets. */
SBI_API int sbi_cell_elements(const sbi_cell *cell, sb_element_type type)
{
    static const int tets[5] = {0, 1, 2, 3, 6};
    const sbi_cell_kind *about = sbi_cell_kind_at(cell->kind);
    if (about->type == type)
        return 1;
    return about->dimension == 3 ? tets[about->shape] : 2;
}

SBI_API int sbi_cell_region(const sbi_loader *loader, const sbi_cell *cell)
{
    return loader->source_regions ? loader->source_regions[cell->source] : cell->region;
}

/* Number of elements the cells make. */
static int64_t sbi_loader_count_elements(const sbi_loader *loader, int dimension, sb_element_type type)
{
    int64_t count = 0;
    for (size_t i = 0; i < loader->cell_count; i++)
        if (sbi_cell_kind_at(loader->cells[i].kind)->dimension == dimension)
            count += sbi_cell_elements(&loader->cells[i], type);
    return count;
}

/* Regions of all elements. */
static void sbi_loader_copy_regions(const sbi_loader *loader, int dimension, sb_mesh *mesh)
{
    int element = 0;
    for (size_t i = 0; i < loader->cell_count; i++) {
        const sbi_cell *cell = &loader->cells[i];
        if (sbi_cell_kind_at(cell->kind)->dimension != dimension)
            continue;
        for (int part = sbi_cell_elements(cell, mesh->element_type); part > 0; part--)
            mesh->regions[element++] = sbi_cell_region(loader, cell);
    }
}

/* Copies the cells of the dimension; a quadrilateral among triangles becomes 0 1 2 and 0 2 3. */
static void sbi_loader_copy_cells(sbi_loader *loader, int dimension, sb_mesh *mesh)
{
    int nodes = sb_element_node_count(mesh->element_type);
    const int *from = loader->indices;
    int *to = mesh->elements;
    for (size_t i = 0; i < loader->cell_count; i++) {
        const sbi_cell_kind *about = sbi_cell_kind_at(loader->cells[i].kind);
        int parts = about->type == mesh->element_type ? 1 : 2;
        for (int part = 0; part < parts && about->dimension == dimension; part++, to += nodes)
            for (int a = 0; a < nodes; a++)
                to[a] = from[a == 0 ? 0 : a + part];
        if (parts == 2 && about->dimension == dimension)
            loader->split_polygons++;
        from += about->nodes;
    }
}

static int sbi_loader_any_region(const int *regions, int count)
{
    for (int i = 0; i < count; i++)
        if (regions[i])
            return 1;
    return 0;
}

SBI_API sb_result sbi_loader_build(sbi_loader *loader, sb_mesh *mesh)
{
    int dimension = sbi_loader_find_dimension(loader), nodes;
    int split = dimension == 3;
    sb_element_type type = SB_NO_ELEMENT;
    int64_t count;
    sb_result result = SB_OK;
    loader->reader.element = loader->reader.node = -1;
    if (dimension < 2)
        return sbi_reader_fail(&loader->reader, SB_ERROR_MESH,
                               "the file has no faces and no volume elements");
    split = split && sbi_split_wanted(loader, &type);
    if (!split)
        result = sbi_loader_find_type(loader, dimension, &type);
    if (result)
        return result;
    count = sbi_loader_count_elements(loader, dimension, type);
    if (count > INT_MAX)
        return sbi_reader_fail(&loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 elements");
    nodes = sb_element_node_count(type);
    mesh->allocator = loader->allocator;
    mesh->element_type = type;
    mesh->element_count = (int)count;
    mesh->elements = (int *)sbi_alloc(&loader->allocator, (size_t)count, (size_t)nodes * sizeof(int));
    mesh->regions = (int *)sbi_alloc(&loader->allocator, (size_t)count, sizeof(int));
    if (!mesh->elements || !mesh->regions)
        return sbi_loader_no_memory(loader);
    if (split)
        result = sbi_split_cells(loader, mesh);
    else
        sbi_loader_copy_cells(loader, dimension, mesh);
    if (result)
        return result;
    sbi_loader_copy_regions(loader, dimension, mesh);
    if (!sbi_loader_any_region(mesh->regions, mesh->element_count)) {
        sbi_free(&loader->allocator, mesh->regions);
        mesh->regions = NULL;
    }
    mesh->node_count = (int)loader->node_count;
    mesh->nodes = loader->nodes;
    loader->nodes = NULL;
    loader->node_count = loader->node_capacity = 0;
    return SB_OK;
}
