/* bytes: see bytes.h. */
#include "bytes.h"

#include <string.h>

/* ---- bits ---- */

SBI_API uint64_t sbi_real_bits(sb_real value)
{
#if SB_REAL_IS_FLOAT
    uint32_t bits;
#else
    uint64_t bits;
#endif
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

SBI_API sb_real sbi_real_of(uint64_t word)
{
#if SB_REAL_IS_FLOAT
    uint32_t bits = (uint32_t)word;
#else
    uint64_t bits = word;
#endif
    sb_real value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* ---- checksums ---- */

/* Four bits at a time. */
SBI_API uint32_t sbi_crc32(const unsigned char *data, size_t size)
{
    static const uint32_t nibbles[16] = {0x00000000, 0x1DB71064, 0x3B6E20C8, 0x26D930AC, 0x76DC4190, 0x6B6B51F4,
                                         0x4DB26158, 0x5005713C, 0xEDB88320, 0xF00F9344, 0xD6D6A3E8, 0xCB61B38C,
                                         0x9B64C2B0, 0x86D3D2D4, 0xA00AE278, 0xBDBDF21C};
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < size; i++) {
        crc ^= data[i];
        crc = crc >> 4 ^ nibbles[crc & 15];
        crc = crc >> 4 ^ nibbles[crc & 15];
    }
    return crc ^ 0xFFFFFFFFu;
}

/* ---- images ---- */

static uint64_t sbi_image_checksum(const unsigned char *bytes, size_t size)
{
    uint64_t hash = size;
    for (; size >= 8; bytes += 8, size -= 8)
        hash = sbi_hash_word(hash, sbi_get_bytes(bytes, 8));
    return sbi_hash_word(hash, sbi_get_bytes(bytes, (int)size));
}

SBI_API void sbi_image_seal(unsigned char *image, size_t size, const char *magic, uint32_t version)
{
    memcpy(image, magic, 8);
    sbi_put_bytes(image + 8, version, 4);
    sbi_put_bytes(image + 12, sizeof(sb_real), 4);
    sbi_put_bytes(image + 16, size, 8);
    sbi_put_bytes(image + size - SBI_IMAGE_TAIL, sbi_image_checksum(image, size - SBI_IMAGE_TAIL), 8);
}

SBI_API sb_result sbi_image_check_head(const unsigned char *image, size_t size, const char *magic, uint32_t version,
                                       const char *what, sb_error *error)
{
    uint64_t real;
    if (size < SBI_IMAGE_HEAD + SBI_IMAGE_TAIL)
        return sbi_fail(error, SB_ERROR_FORMAT, "%lu bytes are too few for a saved %s", (unsigned long)size, what);
    if (memcmp(image, magic, 8) != 0)
        return sbi_fail(error, SB_ERROR_FORMAT, "these are not the bytes of a saved %s", what);
    if (sbi_get_bytes(image + 8, 4) != version)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the saved %s has version %lu, this library reads %lu", what,
                        (unsigned long)sbi_get_bytes(image + 8, 4), (unsigned long)version);
    real = sbi_get_bytes(image + 12, 4);
    if (real != sizeof(sb_real))
        return sbi_fail(error, real == 4 || real == 8 ? SB_ERROR_UNSUPPORTED : SB_ERROR_FORMAT,
                        "the saved %s has reals of %lu bytes, this library has %lu", what, (unsigned long)real,
                        (unsigned long)sizeof(sb_real));
    return SB_OK;
}

SBI_API sb_result sbi_image_check(const unsigned char *image, size_t size, const char *magic, uint32_t version,
                                  const char *what, sb_error *error)
{
    sb_result result = sbi_image_check_head(image, size, magic, version, what, error);
    if (result != SB_OK)
        return result;
    if (sbi_get_bytes(image + 16, 8) != (uint64_t)size)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved %s is %s than the size it states", what,
                        sbi_get_bytes(image + 16, 8) > (uint64_t)size ? "shorter" : "longer");
    if (sbi_get_bytes(image + size - SBI_IMAGE_TAIL, 8) != sbi_image_checksum(image, size - SBI_IMAGE_TAIL))
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved %s is damaged: its checksum differs", what);
    return SB_OK;
}
