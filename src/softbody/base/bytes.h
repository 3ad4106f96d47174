/* bytes: images in memory that state what they are, and whether they are whole. Floor 0, internal. */
#ifndef SB_BYTES_H
#define SB_BYTES_H

#include "core.h"

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
enum { SBI_IMAGE_HEAD = 24, SBI_IMAGE_TAIL = 8 }; /* bytes before and after the content of an image */

/* One step of the hash: words in order. */
SB_INLINE uint64_t sbi_hash_word(uint64_t hash, uint64_t word)
{
    hash = (hash ^ word) * 0x9E3779B97F4A7C15u;
    return hash ^ (hash >> 32);
}

/* Little-endian numbers of 1 to 8 bytes. */
SB_INLINE void sbi_put_bytes(unsigned char *to, uint64_t value, int bytes)
{
    for (int i = 0; i < bytes; i++)
        to[i] = (unsigned char)(value >> (8 * i) & 0xFF);
}
SB_INLINE uint64_t sbi_get_bytes(const unsigned char *from, int bytes)
{
    uint64_t value = 0;
    for (int i = 0; i < bytes; i++)
        value |= (uint64_t)from[i] << (8 * i);
    return value;
}
/* The low 32 bits of a number as a signed integer, and back. */
SB_INLINE int sbi_int_of(uint64_t word)
{
    uint32_t bits = (uint32_t)word;
    return bits <= 0x7FFFFFFFu ? (int)bits : -(int)(0xFFFFFFFFu - bits) - 1;
}
/* The bits of a real, and back. */
SBI_API uint64_t sbi_real_bits(sb_real value);
SBI_API sb_real sbi_real_of(uint64_t bits);

/* CRC-32 of gzip and zip: RFC 1952. */
SBI_API uint32_t sbi_crc32(const unsigned char *data, size_t size);

/* An image is head, content, checksum. Writes head and checksum around a content that is there already;
 * magic: 8 bytes. */
SBI_API void sbi_image_seal(unsigned char *image, size_t size, const char *magic, uint32_t version);
/* Checks what sbi_image_seal wrote; `what` names the thing in messages ("state"). */
SBI_API sb_result sbi_image_check(const unsigned char *image, size_t size, const char *magic, uint32_t version,
                                  const char *what, sb_error *error);
/* The part of it that the first SBI_IMAGE_HEAD bytes settle. */
SBI_API sb_result sbi_image_check_head(const unsigned char *image, size_t size, const char *magic, uint32_t version,
                                       const char *what, sb_error *error);
#endif

#endif /* SB_BYTES_H */
