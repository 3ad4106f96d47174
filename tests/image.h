/* image.h: changes saved states and recordings behind the library's back, with a checksum that is right again. Written
 * from the description of the format, not from the library's code. */
#ifndef IMAGE_H
#define IMAGE_H

#include <stdint.h>
#include <string.h>

#include "softbody.h"

static inline uint64_t image_number(const unsigned char *at, size_t bytes)
{
    uint64_t value = 0;
    for (size_t i = 0; i < bytes; i++)
        value |= (uint64_t)at[i] << (8 * i);
    return value;
}

static inline void image_put(unsigned char *at, uint64_t value, size_t bytes)
{
    for (size_t i = 0; i < bytes; i++)
        at[i] = (unsigned char)(value >> (8 * i) & 0xFF);
}

/* Checksum of bytes: words of 8, the last one filled up with zeros. */
static inline uint64_t image_checksum(const unsigned char *bytes, size_t size)
{
    uint64_t hash = size;
    for (size_t at = 0; at <= size; at += 8) {
        hash = (hash ^ image_number(bytes + at, size - at < 8 ? size - at : 8)) * 0x9E3779B97F4A7C15u;
        hash ^= hash >> 32;
    }
    return hash;
}

/* Size and checksum as they should be. */
static inline void image_seal(unsigned char *image, size_t size)
{
    image_put(image + 16, size, 8);
    image_put(image + size - 8, image_checksum(image, size - 8), 8);
}

static inline void image_put_real(unsigned char *at, sb_real value)
{
    uint64_t bits = 0;
#if SB_REAL_IS_FLOAT
    uint32_t half;
    memcpy(&half, &value, sizeof half);
    bits = half;
#else
    memcpy(&bits, &value, sizeof bits);
#endif
    image_put(at, bits, sizeof value);
}

/* Where a number stands for the first time at or after a place; size when nowhere. */
static inline size_t image_find_real(const unsigned char *image, size_t size, size_t from, sb_real value)
{
    unsigned char pattern[sizeof(sb_real)];
    image_put_real(pattern, value);
    for (size_t at = from; at + sizeof pattern <= size; at++)
        if (memcmp(image + at, pattern, sizeof pattern) == 0)
            return at;
    return size;
}

#endif /* IMAGE_H */
