/* meshio_inflate: unpacks zlib streams, as VTK's XML files have them, and gzip. Source: RFC 1950 (zlib), RFC 1951
 * (deflate), RFC 1952 (gzip).
 * The stream is untrusted: the output grows with what is really unpacked, never with what the stream claims. */
#include "meshio_reader.h"

#include "../base/bytes.h"

#include <string.h>

enum { SBI_INFLATE_BITS = 15, SBI_INFLATE_LENGTHS = 288, SBI_INFLATE_DISTANCES = 30 };

typedef struct sbi_inflater {
    const sb_allocator *allocator;
    const unsigned char *data;
    size_t size, at;
    uint32_t bits; /* read, but not used yet; the next one is the lowest */
    int bit_count;
    unsigned char *out;
    size_t out_start, out_size, out_capacity, limit;
    const char *wrong; /* NULL, or why it ended; "": memory */
} sbi_inflater;

/* A canonical Huffman code: how many symbols there are of each length, and the symbols in order. */
typedef struct sbi_inflate_code {
    int count[SBI_INFLATE_BITS + 1];
    int symbol[SBI_INFLATE_LENGTHS];
} sbi_inflate_code;

/* The next `count` <= 16 bits; zeros once something is wrong. */
static unsigned sbi_inflate_bits(sbi_inflater *z, int count)
{
    unsigned value;
    while (z->bit_count < count) {
        if (z->at >= z->size) {
            z->wrong = "it ends too early";
            return 0;
        }
        z->bits |= (uint32_t)z->data[z->at++] << z->bit_count;
        z->bit_count += 8;
    }
    value = (unsigned)(z->bits & (((uint32_t)1 << count) - 1));
    z->bits >>= count;
    z->bit_count -= count;
    return value;
}

/* Room for `more` bytes of output. */
static int sbi_inflate_reserve(sbi_inflater *z, size_t more)
{
    size_t needed, capacity = z->out_capacity < 256 ? 256 : z->out_capacity;
    unsigned char *grown;
    if (more > z->limit - (z->out_size - z->out_start)) {
        z->wrong = "it holds more than it announces";
        return 0;
    }
    if (more > (size_t)-1 - z->out_size) {
        z->wrong = "";
        return 0;
    }
    needed = z->out_size + more;
    if (needed <= z->out_capacity)
        return 1;
    while (capacity < needed)
        capacity = capacity > (size_t)-1 / 2 ? needed : 2 * capacity;
    grown = (unsigned char *)sbi_alloc(z->allocator, capacity, 1);
    if (!grown) {
        z->wrong = "";
        return 0;
    }
    if (z->out_size)
        memcpy(grown, z->out, z->out_size);
    sbi_free(z->allocator, z->out);
    z->out = grown;
    z->out_capacity = capacity;
    return 1;
}

/* Builds the code of symbols with these lengths; 0 when it is over-subscribed, or incomplete with more than one
 * symbol. */
static int sbi_inflate_build(sbi_inflate_code *code, const unsigned char *lengths, int symbols)
{
    int first[SBI_INFLATE_BITS + 2], left = 1, used = 0;
    memset(code->count, 0, sizeof code->count);
    for (int i = 0; i < symbols; i++)
        code->count[lengths[i]]++;
    used = symbols - code->count[0];
    code->count[0] = 0;
    first[1] = 0;
    for (int length = 1; length <= SBI_INFLATE_BITS; length++) {
        left = 2 * left - code->count[length];
        if (left < 0)
            return 0;
        first[length + 1] = first[length] + code->count[length];
    }
    for (int i = 0; i < symbols; i++)
        if (lengths[i])
            code->symbol[first[lengths[i]]++] = i;
    return left == 0 || used <= 1;
}

/* The next symbol, or -1. Codes of one length are consecutive numbers, read from their highest bit. */
static int sbi_inflate_symbol(sbi_inflater *z, const sbi_inflate_code *code)
{
    int value = 0, first = 0, index = 0;
    for (int length = 1; length <= SBI_INFLATE_BITS && !z->wrong; length++) {
        int count = code->count[length];
        value |= (int)sbi_inflate_bits(z, 1);
        if (value - first < count)
            return z->wrong ? -1 : code->symbol[index + (value - first)];
        index += count;
        first = (first + count) << 1;
        value <<= 1;
    }
    if (!z->wrong)
        z->wrong = "it has a code that it does not define";
    return -1;
}

/* A block as it is. */
static void sbi_inflate_stored(sbi_inflater *z)
{
    unsigned length, complement;
    z->bits = 0;
    z->bit_count = 0;
    length = sbi_inflate_bits(z, 16);
    complement = sbi_inflate_bits(z, 16);
    if (z->wrong)
        return;
    if (length != (~complement & 0xFFFFu) || length > z->size - z->at) {
        z->wrong = "a stored block has a wrong length";
        return;
    }
    if (length && sbi_inflate_reserve(z, length)) {
        memcpy(z->out + z->out_size, z->data + z->at, length);
        z->out_size += length;
        z->at += length;
    }
}

/* `length` bytes from `distance` before the end; the two may overlap. */
static void sbi_inflate_copy(sbi_inflater *z, size_t length, size_t distance)
{
    if (distance > z->out_size - z->out_start) {
        z->wrong = "it refers to bytes before its start";
        return;
    }
    if (!sbi_inflate_reserve(z, length))
        return;
    for (; length > 0; length--, z->out_size++)
        z->out[z->out_size] = z->out[z->out_size - distance];
}

static void sbi_inflate_block(sbi_inflater *z, const sbi_inflate_code *literals, const sbi_inflate_code *distances)
{
    static const short base[29] = {3,  4,  5,  6,  7,  8,  9,  10, 11,  13,  15,  17,  19,  23, 27,
                                   31, 35, 43, 51, 59, 67, 83, 99, 115, 131, 163, 195, 227, 258};
    static const signed char extra[29] = {0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2,
                                          2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0};
    while (!z->wrong) {
        int symbol = sbi_inflate_symbol(z, literals), length, distance;
        if (z->wrong || symbol == 256)
            return;
        if (symbol < 256) {
            if (sbi_inflate_reserve(z, 1))
                z->out[z->out_size++] = (unsigned char)symbol;
            continue;
        }
        symbol -= 257;
        if (symbol >= 29) {
            z->wrong = "it has an unknown length";
            return;
        }
        length = base[symbol] + (int)sbi_inflate_bits(z, extra[symbol]);
        symbol = sbi_inflate_symbol(z, distances);
        if (!z->wrong && symbol >= SBI_INFLATE_DISTANCES)
            z->wrong = "it has an unknown distance";
        if (z->wrong)
            return;
        /* 1 2 3 4, then two of each number of extra bits */
        distance = symbol < 4 ? symbol + 1
                              : 1 + ((2 + symbol % 2) << (symbol / 2 - 1)) + (int)sbi_inflate_bits(z, symbol / 2 - 1);
        if (!z->wrong)
            sbi_inflate_copy(z, (size_t)length, (size_t)distance);
    }
}

static void sbi_inflate_fixed(sbi_inflater *z)
{
    unsigned char lengths[SBI_INFLATE_LENGTHS];
    sbi_inflate_code literals, distances;
    for (int i = 0; i < SBI_INFLATE_LENGTHS; i++)
        lengths[i] = (unsigned char)(i < 144 ? 8 : i < 256 ? 9 : i < 280 ? 7 : 8);
    sbi_inflate_build(&literals, lengths, SBI_INFLATE_LENGTHS);
    memset(lengths, 5, 32);
    sbi_inflate_build(&distances, lengths, 32);
    sbi_inflate_block(z, &literals, &distances);
}

/* Lengths of both codes, packed with a code of their own: 16 repeats the last, 17 and 18 are runs of zeros. */
static void sbi_inflate_lengths(sbi_inflater *z, const sbi_inflate_code *code, unsigned char *lengths, int count)
{
    int at = 0;
    while (at < count) {
        int symbol = sbi_inflate_symbol(z, code), repeat;
        unsigned char value = 0;
        if (z->wrong)
            return;
        if (symbol < 16) {
            lengths[at++] = (unsigned char)symbol;
            continue;
        }
        if (symbol == 16 && at > 0)
            value = lengths[at - 1];
        repeat = symbol == 16   ? 3 + (int)sbi_inflate_bits(z, 2)
                 : symbol == 17 ? 3 + (int)sbi_inflate_bits(z, 3)
                                : 11 + (int)sbi_inflate_bits(z, 7);
        if (!z->wrong && (repeat > count - at || (symbol == 16 && at == 0)))
            z->wrong = "its code lengths do not fit";
        for (; repeat > 0 && !z->wrong; repeat--)
            lengths[at++] = value;
    }
}

static void sbi_inflate_dynamic(sbi_inflater *z)
{
    static const unsigned char order[19] = {16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15};
    unsigned char lengths[286 + SBI_INFLATE_DISTANCES + 2];
    sbi_inflate_code literals, distances;
    int literal_count = 257 + (int)sbi_inflate_bits(z, 5), distance_count = 1 + (int)sbi_inflate_bits(z, 5);
    int count = 4 + (int)sbi_inflate_bits(z, 4);
    if (literal_count > 286 || distance_count > SBI_INFLATE_DISTANCES) {
        z->wrong = "it has too many codes";
        return;
    }
    memset(lengths, 0, 19);
    for (int i = 0; i < count; i++)
        lengths[order[i]] = (unsigned char)sbi_inflate_bits(z, 3);
    if (!sbi_inflate_build(&literals, lengths, 19)) {
        z->wrong = "its code lengths make no code";
        return;
    }
    memset(lengths, 0, sizeof lengths);
    sbi_inflate_lengths(z, &literals, lengths, literal_count + distance_count);
    if (z->wrong)
        return;
    if (lengths[256] == 0 || !sbi_inflate_build(&literals, lengths, literal_count) ||
        !sbi_inflate_build(&distances, lengths + literal_count, distance_count)) {
        z->wrong = "its code lengths make no code";
        return;
    }
    sbi_inflate_block(z, &literals, &distances);
}

/* Adler-32: two sums modulo 65521 (RFC 1950). */
static uint32_t sbi_inflate_checksum(const unsigned char *data, size_t size)
{
    uint32_t a = 1, b = 0;
    while (size > 0) {
        size_t part = size < 5552 ? size : 5552; /* the most that cannot overflow */
        for (size_t i = 0; i < part; i++) {
            a += data[i];
            b += a;
        }
        a %= 65521;
        b %= 65521;
        data += part;
        size -= part;
    }
    return b << 16 | a;
}

static void sbi_inflate_blocks(sbi_inflater *z)
{
    unsigned last = 0;
    while (!last && !z->wrong) {
        unsigned kind;
        last = sbi_inflate_bits(z, 1);
        kind = sbi_inflate_bits(z, 2);
        if (z->wrong)
            return;
        if (kind == 0)
            sbi_inflate_stored(z);
        else if (kind == 1)
            sbi_inflate_fixed(z);
        else if (kind == 2)
            sbi_inflate_dynamic(z);
        else
            z->wrong = "it has a block of an unknown kind";
    }
}

/* Unpacks the blocks from data[at] on; *end: where they end. *out and what goes with it may have changed although
 * something is wrong. */
static const char *sbi_inflate_from(const sb_allocator *allocator, const unsigned char *data, size_t size, size_t at,
                                    size_t limit, unsigned char **out, size_t out_size, size_t *out_capacity,
                                    size_t *end, size_t *out_end)
{
    sbi_inflater z;
    memset(&z, 0, sizeof z);
    z.allocator = allocator;
    z.data = data;
    z.size = size;
    z.at = at;
    z.out = *out;
    z.out_start = z.out_size = out_size;
    z.out_capacity = *out_capacity;
    z.limit = limit;
    sbi_inflate_blocks(&z);
    *out = z.out; /* which may have moved, also when something went wrong */
    *out_capacity = z.out_capacity;
    *end = z.at - (size_t)(z.bit_count / 8);
    *out_end = z.out_size;
    return z.wrong;
}

SBI_API const char *sbi_inflate(const sb_allocator *allocator, const unsigned char *data, size_t size, size_t limit,
                                unsigned char **out, size_t *out_size, size_t *out_capacity)
{
    size_t end = 0, out_end = 0;
    const char *wrong;
    if (size < 6 || (data[0] & 15) != 8 || (data[0] >> 4) > 7 || (data[0] * 256 + data[1]) % 31 != 0 || (data[1] & 32))
        return "it has no zlib header";
    wrong = sbi_inflate_from(allocator, data, size, 2, limit, out, *out_size, out_capacity, &end, &out_end);
    if (wrong)
        return wrong;
    if (size - end < 4)
        return "its checksum is missing";
    if (sbi_inflate_checksum(*out ? *out + *out_size : NULL, out_end - *out_size) !=
        ((uint32_t)data[end] << 24 | (uint32_t)data[end + 1] << 16 | (uint32_t)data[end + 2] << 8 | data[end + 3]))
        return "its checksum is wrong";
    *out_size = out_end;
    return NULL;
}

/* Bytes of the header of a gzip member; 0: it is none, or cut off. */
static size_t sbi_inflate_gzip_header(const unsigned char *data, size_t size)
{
    enum { EXTRA = 4, NAME = 8, COMMENT = 16, CHECKSUM = 2, RESERVED = 0xE0 };
    size_t at = 10;
    if (size < 18 || data[0] != 0x1F || data[1] != 0x8B || data[2] != 8 || (data[3] & RESERVED))
        return 0;
    if (data[3] & EXTRA)
        at += 2u + (data[10] | (size_t)data[11] << 8);
    for (int flag = NAME; flag <= COMMENT; flag *= 2)
        if (data[3] & flag) {
            while (at < size && data[at])
                at++;
            at++;
        }
    if (data[3] & CHECKSUM)
        at += 2;
    return at < size ? at : 0;
}

SBI_API const char *sbi_gunzip(const sb_allocator *allocator, const unsigned char *data, size_t size, size_t limit,
                               unsigned char **out, size_t *out_size, size_t *out_capacity)
{
    size_t end = 0, out_end = 0, at = sbi_inflate_gzip_header(data, size), length;
    const char *wrong;
    uint32_t tail[2] = {0, 0};
    if (at == 0)
        return "it has no gzip header";
    wrong = sbi_inflate_from(allocator, data, size, at, limit, out, *out_size, out_capacity, &end, &out_end);
    if (wrong)
        return wrong;
    if (size - end < 8)
        return "its checksum is missing";
    for (size_t i = 0; i < 8; i++)
        tail[i / 4] |= (uint32_t)data[end + i] << (8 * (i % 4));
    length = out_end - *out_size;
    if (tail[0] != sbi_crc32(*out ? *out + *out_size : NULL, length) || tail[1] != (uint32_t)(length & 0xFFFFFFFFu))
        return "its checksum is wrong";
    if (size - end > 8)
        return "something follows its end";
    *out_size = out_end;
    return NULL;
}

SBI_API int sbi_gunzip_start(const sb_allocator *allocator, const unsigned char *data, size_t size, size_t least,
                             unsigned char **out, size_t *out_size)
{
    size_t at = sbi_inflate_gzip_header(data, size), end = 0, capacity = 0;
    const char *wrong = NULL;
    *out = NULL;
    *out_size = 0;
    if (at > 0) /* a block that is stored as it is adds 65535 bytes at once, or none */
        wrong = sbi_inflate_from(allocator, data, size, at, least + 65535, out, 0, &capacity, &end, out_size);
    return !wrong || wrong[0] != 0;
}
