/* image: bytes of a saved state. Floor 6, internal.
 *
 * One function per object names its parts in order, whatever for: measuring, writing and reading are the same walk. */
#ifndef NDL_IMAGE_H
#define NDL_IMAGE_H

#include "../softbody/body/state.h"
#include "../softbody/body/state_part.h"
#include "api.h"

#include <string.h>

enum { NDLI_IMAGE_VERSION = 1, NDLI_IMAGE_ORDER = 0x01020304 };

/* None of the three: measures. */
typedef struct ndli_image {
    unsigned char *out;
    const unsigned char *in;
    sbi_state_out *state; /* of a body that the object is a part of */
    size_t used;
    int overflow;
} ndli_image;

/* What a part of so many bytes takes: parts begin at multiples of eight. */
SB_INLINE size_t ndli_image_room(size_t bytes) { return (bytes + 7) / 8 * 8; }

/* Returns where the part begins. */
SB_INLINE size_t ndli_image_part(ndli_image *image, void *array, size_t count, size_t size)
{
    size_t at = image->used, bytes = count * size, room;
    if (size && count > ((size_t)-1 - 16 - at) / size) {
        image->overflow = 1;
        return at;
    }
    room = ndli_image_room(bytes);
    if (image->state) {
        static const unsigned char zeros[8] = {0};
        sbi_state_put(image->state, array, bytes);
        sbi_state_put(image->state, zeros, room - bytes);
    }
    if (image->in && bytes)
        memcpy(array, image->in + at, bytes);
    if (image->out) {
        if (bytes)
            memcpy(image->out + at, array, bytes);
        memset(image->out + at + bytes, 0, room - bytes);
    }
    image->used = at + room;
    return at;
}

/* Number i of an array of ints in bytes of any alignment. */
SB_INLINE int ndli_image_int(const unsigned char *array, size_t i)
{
    int value;
    memcpy(&value, array + i * sizeof(int), sizeof value);
    return value;
}

SB_INLINE double ndli_image_real(const unsigned char *array, size_t i)
{
    double value;
    memcpy(&value, array + i * sizeof value, sizeof value);
    return value;
}

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* The checks that all loads begin with: kind, version, precision, size, checksum. Bytes behind the image do no harm.
 * magic: 8 bytes. */
NDLI_API sb_result ndli_image_check(const void *buffer, size_t size, const char *magic, const char *what,
                                    sb_error *error);
/* Hash of bytes whose number is a multiple of eight, or which are ints. */
NDLI_API uint64_t ndli_image_hash(uint64_t hash, const void *bytes, size_t size);
/* 1 when none of the numbers is NaN or infinite. */
NDLI_API int ndli_image_is_finite(const unsigned char *reals, size_t count);
#endif

#endif /* NDL_IMAGE_H */
