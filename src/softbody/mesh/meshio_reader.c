/* meshio_reader: the bounded reader that all mesh formats share, and a stable sort. */
#include "meshio_reader.h"

#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* ==== reader ======================================================================================= */

SBI_API void sbi_reader_init(sbi_reader *reader, const void *data, size_t size, const char *name, sb_error *error)
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

/* Whether the file begins with `start`, whatever the case of its letters. */
static int sbi_reader_begins(const sbi_reader *reader, const char *start)
{
    sbi_word word;
    word.text = reader->data;
    word.length = strlen(start);
    return reader->size >= word.length && sbi_word_is(word, start);
}

/* By its byte order mark. */
static int sbi_reader_is_utf16(const sbi_reader *reader)
{
    return reader->size >= 4 && ((memcmp(reader->data, "\xFF\xFE", 2) == 0 && reader->data[3] == 0) ||
                                 (memcmp(reader->data, "\xFE\xFF", 2) == 0 && reader->data[2] == 0));
}

SBI_API sb_result sbi_reader_check_kind(const sbi_reader *reader)
{
    static const struct {
        char start[20];
        char kind[72];
    } kinds[] = {{"\x1F\x8B", "packed by gzip: unpack it first"},
                 {"PK\x03\x04", "a zip archive: unpack it first"},
                 {"7z\xBC\xAF\x27\x1C", "a 7z archive: unpack it first"},
                 {"BZh", "packed by bzip2: unpack it first"},
                 {"\xFD"
                  "7zXZ",
                  "packed by xz: unpack it first"},
                 {"version https://git", "a pointer of git LFS, not the file itself: fetch it with git lfs pull"},
                 {"<!DOCTYPE html", "a web page, not the file that it shows or links to"},
                 {"<html", "a web page, not the file that it shows or links to"},
                 {"\x89PNG", "a PNG picture"},
                 {"%PDF", "a PDF document"}};
    if (sbi_reader_is_utf16(reader))
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "text in UTF-16 is not read: save it as UTF-8");
    for (size_t i = 0; i < sizeof kinds / sizeof kinds[0]; i++)
        if (sbi_reader_begins(reader, kinds[i].start))
            return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "the file is %s", kinds[i].kind);
    return SB_OK;
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

static sb_result sbi_reader_fail_word(const sbi_reader *reader, const char *what, sbi_word word, const char *why)
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
    return sbi_reader_fail(reader, SB_ERROR_NOT_FINITE, "%s: '%s' is not finite", what, sbi_word_print(word, text));
}

SBI_API sb_result sbi_reader_check_count(const sbi_reader *reader, const char *what, int64_t value, size_t bytes,
                                         int *count)
{
    if (value < 0)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "%s is negative: %lld", what, (long long)value);
    if (value > INT_MAX)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "%s is larger than 2147483647: %lld", what, (long long)value);
    /* + 1: in a text the last blank may be missing */
    if (bytes && (uint64_t)value > ((uint64_t)sbi_reader_left(reader) + 1) / bytes)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "%s is %lld, but the file is too short for that", what,
                               (long long)value);
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
