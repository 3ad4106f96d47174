/* Target: messages of OpenIGTLink one behind the other, read in every way and done to an organ. Sizes and checksums are
 * set right, so that what they hold is looked at. */
#ifndef TARGET_IGTL_H
#define TARGET_IGTL_H

#include "examples/system.h"

#include "fuzz.h"

#include "examples/igtl.h"
#include "examples/organ_scene.h"

#include "examples/igtl_organ.h"

enum { FUZZ_IGTL_MESSAGES = 8 };

/* What is accepted must lie within the bytes. */
static inline void fuzz_read_igtl(const igtl_message *m)
{
    const unsigned char *end = m->content + m->content_size;
    igtl_polydata p;
    igtl_array a;
    sb_error error;
    if (igtl_get_polydata(m, &p, &error) == SB_OK)
        for (int i = 0; i < p.attribute_count; i++)
            FUZZ_REQUIRE(4 * p.attributes[i].count * (size_t)p.attributes[i].components <=
                         (size_t)(end - p.attributes[i].bytes));
    if (igtl_get_array(m, &a, &error) == SB_OK)
        FUZZ_REQUIRE(a.count * igtl_array_width(a.type) <= (size_t)(end - a.bytes));
    for (int i = 0; i < m->entry_count; i++)
        FUZZ_REQUIRE(igtl_get_entry(m, i).value_length <= m->header.body);
}

/* Does the next message to the organ; returns the bytes that it took, 0 at the end. */
static inline size_t fuzz_take_igtl(igtl_organ *o, const uint8_t *data, size_t size)
{
    unsigned char *bytes;
    igtl_message m;
    sb_error error;
    size_t body;
    int known;
    if (size < IGTL_HEADER)
        return 0;
    body = (size_t)(igtl_get_u64(data + 42) % 4096);
    body = body < size - IGTL_HEADER ? body : size - IGTL_HEADER;
    bytes = (unsigned char *)malloc(IGTL_HEADER + body);
    FUZZ_REQUIRE(bytes != NULL);
    memcpy(bytes, data, IGTL_HEADER + body);
    igtl_put_u64(bytes + 42, body);
    igtl_put_u64(bytes + 50, igtl_crc_of(&o->crc, bytes + IGTL_HEADER, body));
    if (igtl_open(&o->crc, bytes, IGTL_HEADER + body, &m, &error) == SB_OK) {
        fuzz_read_igtl(&m);
        igtl_organ_take(o, &m, &known);
    } else {
        FUZZ_REQUIRE(error.message[0]);
    }
    free(bytes);
    return IGTL_HEADER + body;
}

static inline void fuzz_igtl(const uint8_t *data, size_t size)
{
    size_t (*const write[4])(igtl_organ *, uint64_t) = {igtl_organ_write_skin, igtl_organ_write_tool,
                                                        igtl_organ_write_force, igtl_organ_write_positions};
    igtl_organ o = igtl_organ_default("fuzz");
    sb_step_info info;
    igtl_message m;
    sb_error error;
    o.radius = 0.3;
    FUZZ_REQUIRE(sb_mesh_beam(SB_TET4, 2, 1, 1, sb_v3(2, 1, 1), NULL, &o.scene.mesh, NULL) == SB_OK);
    FUZZ_REQUIRE(igtl_organ_make(&o) == 0);
    for (int i = 0; i < FUZZ_IGTL_MESSAGES; i++) {
        size_t taken = fuzz_take_igtl(&o, data, size);
        if (!taken)
            break;
        data += taken;
        size -= taken;
        sb_body_step(o.scene.body, (sb_real)0.02, &info);
        for (int k = 0; k < o.scene.mesh.node_count; k++)
            FUZZ_REQUIRE(sb_v3_is_finite(sb_body_positions(o.scene.body)[k]));
    }
    for (int k = 0; k < 4; k++) { /* what it writes can be read */
        size_t written = write[k](&o, 0);
        FUZZ_REQUIRE(written > 0 && igtl_open(&o.crc, o.message, written, &m, &error) == SB_OK);
    }
    igtl_organ_free(&o);
}

#endif /* TARGET_IGTL_H */
