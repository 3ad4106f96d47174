/* mesh_file.h: mesh files built byte by byte, and the two tetrahedra that they hold. */
#ifndef MESH_FILE_H
#define MESH_FILE_H

#include <stdint.h>

#include "softbody.h"

#include "check.h"

/* ---- bytes of a file ------------------------------------------------------------------------------ */

typedef struct bytes {
    unsigned char *data;
    size_t size, capacity;
    int big_endian;
} bytes;

static inline void put(bytes *b, const void *data, size_t size)
{
    if (b->size + size > b->capacity) {
        b->capacity = 2 * (b->size + size) + 64;
        b->data = (unsigned char *)realloc(b->data, b->capacity);
    }
    if (size)
        memcpy(b->data + b->size, data, size);
    b->size += size;
}

static inline void put_text(bytes *b, const char *text) { put(b, text, strlen(text)); }

static inline void put_bits(bytes *b, uint64_t bits, int size)
{
    unsigned char out[8];
    for (int i = 0; i < size; i++)
        out[b->big_endian ? size - 1 - i : i] = (unsigned char)(bits >> (8 * i) & 0xFF);
    put(b, out, (size_t)size);
}

static inline void put_int(bytes *b, long long value, int size) { put_bits(b, (uint64_t)value, size); }

static inline void put_real(bytes *b, double value, int size)
{
    float single = (float)value;
    uint32_t low;
    uint64_t bits;
    memcpy(&low, &single, sizeof low);
    memcpy(&bits, &value, sizeof bits);
    put_bits(b, size == 4 ? low : bits, size);
}

/* An integer, or a number in double precision, in text or binary. */
static inline void put_integer(bytes *b, int binary, long long value, int size)
{
    char text[32];
    snprintf(text, sizeof text, "%lld ", value);
    if (binary)
        put_int(b, value, size);
    else
        put_text(b, text);
}

static inline void put_double(bytes *b, int binary, double value)
{
    char text[40];
    snprintf(text, sizeof text, "%.17g ", value);
    if (binary)
        put_real(b, value, 8);
    else
        put_text(b, text);
}

static inline void bytes_free(bytes *b)
{
    free(b->data);
    memset(b, 0, sizeof *b);
}

/* ---- the mesh of the built files      ------------------------------------------------------------ */

/* Two tetrahedra that share a face; volume 1/2; regions 3 and 7. */
static const double pair_nodes[5][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 1, 1}};
static const int pair_cells[2][4] = {{0, 1, 2, 3}, {1, 2, 3, 4}};
static const int pair_regions[2] = {3, 7};

static inline void expect_nodes(const sb_mesh *mesh, const double nodes[][3], int count)
{
    if (!CHECK_INT(mesh->node_count, count))
        return;
    for (int i = 0; i < count; i++)
        CHECK(mesh->nodes[i].x == (sb_real)nodes[i][0] && mesh->nodes[i].y == (sb_real)nodes[i][1] &&
              mesh->nodes[i].z == (sb_real)nodes[i][2]);
}

static inline void expect_pair(const sb_mesh *mesh)
{
    expect_nodes(mesh, pair_nodes, 5);
    CHECK_INT(mesh->element_type, SB_TET4);
    if (!CHECK_INT(mesh->element_count, 2))
        return;
    CHECK(memcmp(mesh->elements, pair_cells, sizeof pair_cells) == 0);
    if (CHECK(mesh->regions != NULL))
        CHECK(memcmp(mesh->regions, pair_regions, sizeof pair_regions) == 0);
}

#endif /* MESH_FILE_H */
