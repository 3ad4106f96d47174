/* fuzz.h: what fuzz targets share: bytes taken as numbers, and the one way to report a finding. */
#ifndef FUZZ_H
#define FUZZ_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "softbody.h"

/* A promise of the library; a violation is a finding. */
#define FUZZ_REQUIRE(condition) fuzz_require((condition) != 0, #condition, __LINE__)
static inline void fuzz_require(int condition, const char *text, int line)
{
    if (!condition) {
        fprintf(stderr, "fuzz: line %d: %s\n", line, text);
        abort();
    }
}

/* The input as a stream that ends in zeros. */
typedef struct fuzz_bytes {
    const uint8_t *data;
    size_t size, at;
} fuzz_bytes;

static inline int fuzz_byte(fuzz_bytes *bytes) { return bytes->at < bytes->size ? bytes->data[bytes->at++] : 0; }
static inline int fuzz_word(fuzz_bytes *bytes)
{
    int low = fuzz_byte(bytes);
    return low + 256 * fuzz_byte(bytes);
}
static inline int fuzz_is_empty(const fuzz_bytes *bytes) { return bytes->at >= bytes->size; }

/* A number: mostly a tame one in [-1, 1], sometimes one of those that break things. */
static inline sb_real fuzz_real(fuzz_bytes *bytes)
{
    static const double wild[16] = {0,    -0.0, 1,     -1,   1e-300, 1e-30,  1e30, -1e30,
                                    1e15, 1e-8, 1e150, 1e38, 1e308,  -1e308, 0.5,  1000};
    int b = fuzz_byte(bytes);
    sb_real infinite = SB_REAL_MAX;
    infinite *= 2;
    if (b == 255)
        return infinite;
    if (b == 254)
        return -infinite;
    if (b == 253)
        return infinite - infinite;
    if (b >= 224)
        return sb_min(sb_max((sb_real)wild[b % 16], -SB_REAL_MAX), SB_REAL_MAX);
    return (sb_real)(b - 112) / 112;
}

static inline sb_vec3 fuzz_vector(fuzz_bytes *bytes)
{
    sb_vec3 v;
    v.x = fuzz_real(bytes);
    v.y = fuzz_real(bytes);
    v.z = fuzz_real(bytes);
    return v;
}

static inline int fuzz_all_finite(const sb_vec3 *v, int count)
{
    for (int i = 0; i < count; i++)
        if (!sb_v3_is_finite(v[i]))
            return 0;
    return 1;
}

/* What holds for every body at any time. */
static inline void fuzz_check_body(sb_body *body)
{
    int n = sb_body_node_count(body);
    FUZZ_REQUIRE(fuzz_all_finite(sb_body_displacements(body), n));
    FUZZ_REQUIRE(fuzz_all_finite(sb_body_velocities(body), n));
}

/* A step of bounded work; one that fails leaves no trace. */
static inline void fuzz_step(sb_body *body, sb_real dt)
{
    uint64_t before = sb_body_state_hash(body);
    sb_step_info info;
    if (sb_body_step(body, dt, &info) != SB_OK) {
        FUZZ_REQUIRE(info.error.result != SB_OK && info.error.message[0]);
        FUZZ_REQUIRE(sb_body_state_hash(body) == before);
    }
    fuzz_check_body(body);
}

static inline void fuzz_solve(sb_body *body, const sb_static_options *options)
{
    uint64_t before = sb_body_state_hash(body);
    sb_step_info info;
    if (sb_body_solve_static(body, options, &info) != SB_OK) {
        FUZZ_REQUIRE(info.error.result != SB_OK && info.error.message[0]);
        FUZZ_REQUIRE(options->keep_progress || sb_body_state_hash(body) == before);
    }
    fuzz_check_body(body);
}

/* Changes single bytes of an image as the rest of the input says, and makes size and checksum right again. */
static inline void fuzz_patch_image(fuzz_bytes *bytes, unsigned char *image, size_t size)
{
    for (int k = 0; k < 16 && !fuzz_is_empty(bytes); k++) {
        size_t at = (size_t)fuzz_word(bytes);
        image[at % size] = (unsigned char)fuzz_byte(bytes);
    }
    sbi_put_bytes(image + 16, size, 8);
    sbi_put_bytes(image + size - SBI_IMAGE_TAIL, sbi_image_checksum(image, size - SBI_IMAGE_TAIL), 8);
}

#endif /* FUZZ_H */
