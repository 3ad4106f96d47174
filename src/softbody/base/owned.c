#include "owned.h"

#include <string.h>

enum { SBI_OWNED_LINE = 64 };

SBI_API void *sbi_owned_take(sbi_owned *owned, size_t count, size_t size)
{
    size_t bytes = 3 * SBI_OWNED_LINE; /* the one before, alignment, and room to read past the end */
    void *raw;
    uintptr_t first;
    if (!sbi_size_add(&bytes, count, size))
        return NULL;
    raw = sbi_alloc(&owned->allocator, bytes, 1);
    if (!raw)
        return NULL;
    memcpy(raw, &owned->last, sizeof owned->last);
    owned->last = raw;
    owned->bytes += bytes;
    first = (uintptr_t)raw + SBI_OWNED_LINE;
    return (char *)raw + SBI_OWNED_LINE + (SBI_OWNED_LINE - first % SBI_OWNED_LINE) % SBI_OWNED_LINE;
}

SBI_API int *sbi_owned_take_ints(sbi_owned *owned, size_t count)
{
    return (int *)sbi_owned_take(owned, count, sizeof(int));
}

/* A line before them and a line after them are 0. */
SBI_API float *sbi_owned_take_unset_floats(sbi_owned *owned, size_t count, size_t width)
{
    const size_t line = SBI_OWNED_LINE / sizeof(float);
    float *floats = NULL;
    if (width == 0 || count <= ((size_t)-1 / sizeof(float) - 2 * line) / width)
        floats = (float *)sbi_owned_take(owned, count * width + line, sizeof(float));
    if (!floats)
        return NULL;
    memset(floats, 0, SBI_OWNED_LINE);
    memset(floats + line + count * width, 0, SBI_OWNED_LINE);
    return floats + line;
}

SBI_API float *sbi_owned_take_floats(sbi_owned *owned, size_t count, size_t width)
{
    float *floats = sbi_owned_take_unset_floats(owned, count, width);
    if (floats)
        memset(floats, 0, count * width * sizeof(float));
    return floats;
}

SBI_API void sbi_owned_free(sbi_owned *owned)
{
    while (owned->last) {
        void *raw = owned->last;
        memcpy(&owned->last, raw, sizeof owned->last);
        sbi_free(&owned->allocator, raw);
    }
    owned->bytes = 0;
}
