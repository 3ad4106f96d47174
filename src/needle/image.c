/* image: what loads check before anything else. */
#include "image.h"

NDLI_API sb_result ndli_image_check(const void *buffer, size_t size, const char *magic, const char *what,
                                    sb_error *error)
{
    const unsigned char *image = (const unsigned char *)buffer;
    uint64_t written;
    if (!buffer)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "buffer is NULL");
    if (size >= SBI_IMAGE_HEAD + SBI_IMAGE_TAIL) {
        written = sbi_get_bytes(image + 16, 8);
        if (written >= SBI_IMAGE_HEAD + SBI_IMAGE_TAIL && written < (uint64_t)size)
            size = (size_t)written;
    }
    return sbi_image_check(image, size, magic, NDLI_IMAGE_VERSION, what, error);
}

NDLI_API uint64_t ndli_image_hash(uint64_t hash, const void *bytes, size_t size)
{
    const unsigned char *at = (const unsigned char *)bytes;
    for (; size >= 8; at += 8, size -= 8) {
        uint64_t word;
        memcpy(&word, at, 8);
        hash = sbi_hash_word(hash, word);
    }
    return size ? sbi_hash_word(hash, sbi_get_bytes(at, (int)size)) : hash;
}

NDLI_API int ndli_image_is_finite(const unsigned char *reals, size_t count)
{
    int good = 1;
    for (size_t i = 0; i < count; i++) {
        sb_real value;
        memcpy(&value, reals + i * sizeof value, sizeof value);
        good &= sb_is_finite(value);
    }
    return good;
}
