/* meshio_medit: reads Medit's meshes (INRIA, also called GMF), .mesh in text and .meshb in binary of either byte order.
 * Source of the format: P. Frey, "MEDIT: an interactive mesh visualization software", INRIA RT-0253, and the numbers of
 * keywords of libMeshb 7. A file is a row of sections: keyword, count, that many rows of numbers, each with a reference
 * at its end. References of cells become regions and sets. */
#include "meshio_reader.h"

#include <limits.h>
#include <string.h>

typedef struct sbi_medit {
    sbi_loader *loader;
    sbi_reader *reader;
    int binary, version; /* of the binary form: 1 floats, 3 long places, 4 long integers */
    int dimension;
    int vertex_references; /* a vertex has one */
} sbi_medit;

/* A section of cells; code: its keyword in binary files. */
typedef struct sbi_medit_section {
    char name[18];
    int code, vtk;
} sbi_medit_section;

enum { SBI_MEDIT_DIMENSION = 3, SBI_MEDIT_VERTICES = 4, SBI_MEDIT_END = 54 };

static const sbi_medit_section *sbi_medit_find(sbi_word name, int64_t code)
{
    static const sbi_medit_section sections[] = {
        {"Edges", 5, 3},         {"Triangles", 6, 5},   {"Quadrilaterals", 7, 9}, {"Tetrahedra", 8, 10},
        {"Prisms", 9, 13},       {"Hexahedra", 10, 12}, {"Pyramids", 49, 14},     {"Pentahedra", -1, 13},
        {"TrianglesP2", 24, 22}, {"EdgesP2", 25, 21},   {"TetrahedraP2", 30, 24}};
    for (size_t i = 0; i < sizeof sections / sizeof sections[0]; i++)
        if (name.length ? sbi_word_is(name, sections[i].name) : sections[i].code == code)
            return &sections[i];
    return NULL;
}

/* ---- values: the same code reads text and binary ---- */

static int sbi_medit_integer_size(const sbi_medit *medit) { return medit->version >= 4 ? 8 : 4; }

static sb_result sbi_medit_bits(sbi_medit *medit, const char *what, int size, int64_t *value)
{
    const unsigned char *bytes = sbi_reader_bytes(medit->reader, 1, (size_t)size, what);
    if (!bytes)
        return SB_ERROR_FORMAT;
    *value = sbi_decode_signed(medit->reader, bytes, size);
    return SB_OK;
}

static sb_result sbi_medit_integer(sbi_medit *medit, const char *what, int64_t *value)
{
    if (!medit->binary)
        return sbi_reader_integer(medit->reader, what, value);
    return sbi_medit_bits(medit, what, sbi_medit_integer_size(medit), value);
}

static sb_result sbi_medit_real(sbi_medit *medit, double *value)
{
    int size = medit->version == 1 ? 4 : 8;
    const unsigned char *bytes;
    if (!medit->binary)
        return sbi_reader_real(medit->reader, "coordinate", value);
    bytes = sbi_reader_bytes(medit->reader, 1, (size_t)size, "coordinates");
    if (!bytes)
        return SB_ERROR_FORMAT;
    *value = sbi_decode_float(medit->reader, bytes, size);
    return SB_OK;
}

/* A number of rows of `numbers` numbers each. */
static sb_result sbi_medit_count(sbi_medit *medit, const char *what, int numbers, int *count)
{
    int64_t value = 0;
    sb_result result = sbi_medit_integer(medit, what, &value);
    return result
               ? result
               : sbi_reader_check_count(medit->reader, what, value, (medit->binary ? 4u : 2u) * (size_t)numbers, count);
}

/* ---- sections ---- */

static sb_result sbi_medit_vertices(sbi_medit *medit)
{
    int count = 0;
    sb_result result;
    if (medit->dimension == 0)
        return sbi_reader_fail(medit->reader, SB_ERROR_FORMAT, "Vertices before Dimension");
    if (medit->loader->node_count)
        return sbi_reader_fail(medit->reader, SB_ERROR_FORMAT, "a second section Vertices");
    result = sbi_medit_count(medit, "the number of vertices", medit->dimension + 1, &count);
    if (!result)
        result = sbi_loader_reserve_nodes(medit->loader, count);
    for (int i = 0; i < count && !result; i++) {
        double x[3] = {0, 0, 0};
        int64_t reference = 0;
        medit->reader->node = i;
        for (int k = 0; k < medit->dimension && !result; k++)
            result = sbi_medit_real(medit, &x[k]);
        if (!result)
            result = sbi_medit_integer(medit, "reference", &reference);
        if (!result)
            result = sbi_loader_add_node(medit->loader, x);
        medit->vertex_references |= reference != 0;
    }
    medit->reader->node = -1;
    return result;
}

/* The reference of a cell: its region and group. */
static sb_result sbi_medit_reference(sbi_medit *medit, int *region)
{
    int64_t reference = 0;
    sb_result result = sbi_medit_integer(medit, "reference", &reference);
    if (!result && (reference < INT_MIN || reference > INT_MAX))
        return sbi_reader_fail(medit->reader, SB_ERROR_FORMAT, "reference %lld is too large", (long long)reference);
    *region = (int)reference;
    return result ? result : sbi_loader_add_groups(medit->loader, region, *region != 0, &medit->loader->cell_groups);
}

static sb_result sbi_medit_cells(sbi_medit *medit, const sbi_medit_section *section)
{
    int kind = sbi_cell_kind_of_vtk(section->vtk), nodes = sbi_cell_kind_at(kind)->nodes, count = 0;
    char what[40];
    sb_result result;
    snprintf(what, sizeof what, "the number of %s", section->name);
    result = sbi_medit_count(medit, what, nodes + 1, &count);
    for (int i = 0; i < count && !result; i++) {
        int64_t node = 0;
        int region = 0;
        sbi_loader_begin_cell(medit->loader);
        for (int k = 0; k < nodes && !result; k++) {
            result = sbi_medit_integer(medit, "node number", &node);
            if (!result)
                result = sbi_loader_cell_node(medit->loader, node, 1);
        }
        if (!result)
            result = sbi_medit_reference(medit, &region);
        if (!result)
            result = sbi_loader_end_cell(medit->loader, kind, SBI_ORDER_SAME, region);
    }
    return result;
}

static sb_result sbi_medit_dimension(sbi_medit *medit)
{
    int64_t dimension = 0;
    sb_result result = medit->binary ? sbi_medit_bits(medit, "dimension", 4, &dimension)
                                     : sbi_reader_integer(medit->reader, "dimension", &dimension);
    if (!result && dimension != 2 && dimension != 3)
        return sbi_reader_fail(medit->reader, SB_ERROR_UNSUPPORTED, "dimension %lld", (long long)dimension);
    medit->dimension = (int)dimension;
    return result;
}

/* Higher-order cells whose order of nodes is not laid down are no plain side information. */
static sb_result sbi_medit_ignore(sbi_medit *medit, sbi_word name)
{
    static const char *const orders[] = {"Q2", "P3", "P4", "Q3", "Q4", "PrismsP2", "PyramidsP2"};
    char text[32];
    for (size_t i = 0; i < sizeof orders / sizeof orders[0]; i++) {
        size_t length = strlen(orders[i]);
        if (name.length >= length && memcmp(name.text + name.length - length, orders[i], length) == 0)
            return sbi_reader_fail(medit->reader, SB_ERROR_UNSUPPORTED, "cells of the kind %s are not read",
                                   sbi_word_print(name, text));
    }
    sbi_loader_ignore(medit->loader, name);
    return SB_OK;
}

/* ---- text ---- */

/* Steps over the numbers up to the next keyword. */
static void sbi_medit_skip_numbers(sbi_reader *reader)
{
    sbi_reader ahead = *reader;
    sbi_word word;
    double value;
    while (sbi_reader_word(&ahead, &word) && sbi_parse_real(word.text, word.length, &value) != 0)
        *reader = ahead;
}

static sb_result sbi_medit_text_section(sbi_medit *medit, sbi_word keyword, int *ended)
{
    const sbi_medit_section *section = sbi_medit_find(keyword, -1);
    char text[32];
    sb_result result;
    int64_t version = 0;
    char first = keyword.text[0];
    *ended = sbi_word_is(keyword, "End");
    if (*ended)
        return SB_OK;
    if (section)
        return sbi_medit_cells(medit, section);
    if (sbi_word_is(keyword, "Vertices"))
        return sbi_medit_vertices(medit);
    if (sbi_word_is(keyword, "Dimension"))
        return sbi_medit_dimension(medit);
    if (sbi_word_is(keyword, "MeshVersionFormatted"))
        return sbi_reader_integer(medit->reader, "version", &version);
    if (!((first >= 'A' && first <= 'Z') || (first >= 'a' && first <= 'z')))
        return sbi_reader_fail(medit->reader, SB_ERROR_FORMAT, "'%s' where a section should begin",
                               sbi_word_print(keyword, text));
    result = sbi_medit_ignore(medit, keyword);
    sbi_medit_skip_numbers(medit->reader);
    return result;
}

/* ---- binary ---- */

SBI_API int sbi_medit_is_binary(const char *data, size_t size)
{
    const unsigned char *b = (const unsigned char *)data;
    int little, version, keyword;
    if (size < 12)
        return 0;
    little = b[0] == 1 && !b[1] && !b[2] && !b[3];
    if (!little && !(b[3] == 1 && !b[0] && !b[1] && !b[2]))
        return 0;
    version = little ? b[4] : b[7];
    keyword = little ? b[8] : b[11];
    for (int i = 0; i < 3; i++) /* the rest of version and first keyword, which is Dimension */
        if (b[little ? 5 + i : 4 + i] || b[little ? 9 + i : 8 + i])
            return 0;
    return version >= 1 && version <= 4 && keyword == SBI_MEDIT_DIMENSION;
}

/* Keyword, place of the next keyword, content. */
static sb_result sbi_medit_binary_section(sbi_medit *medit, int *ended)
{
    const sbi_medit_section *section;
    sbi_word none = {"", 0}, name;
    char text[32];
    int64_t code = 0, next = 0;
    sb_result result = sbi_medit_bits(medit, "a keyword", 4, &code);
    *ended = code == SBI_MEDIT_END;
    if (!result && !*ended)
        result = sbi_medit_bits(medit, "the place of the next keyword", medit->version >= 3 ? 8 : 4, &next);
    if (result || *ended)
        return result;
    if (next <= 0 || (uint64_t)next < (uint64_t)medit->reader->at || (uint64_t)next > (uint64_t)medit->reader->size)
        return sbi_reader_fail(medit->reader, SB_ERROR_FORMAT, "the next keyword would be at byte %lld",
                               (long long)next);
    section = sbi_medit_find(none, code);
    if (section) {
        result = sbi_medit_cells(medit, section);
    } else if (code == SBI_MEDIT_VERTICES) {
        result = sbi_medit_vertices(medit);
    } else if (code == SBI_MEDIT_DIMENSION) {
        result = sbi_medit_dimension(medit);
    } else {
        name.length = (size_t)snprintf(text, sizeof text, "keyword %lld", (long long)code);
        name.text = text;
        sbi_loader_ignore(medit->loader, name);
        medit->reader->at = (size_t)next;
    }
    if (!result && medit->reader->at > (size_t)next)
        return sbi_reader_fail(medit->reader, SB_ERROR_FORMAT, "a section is longer than it announces");
    medit->reader->at = result ? medit->reader->at : (size_t)next;
    return result;
}

static sb_result sbi_medit_read_binary(sbi_medit *medit)
{
    int64_t version = 0;
    int ended = 0;
    sb_result result;
    medit->binary = medit->reader->binary = 1;
    medit->reader->big_endian = medit->reader->data[0] == 0;
    medit->reader->at = 4;
    result = sbi_medit_bits(medit, "version", 4, &version);
    medit->version = (int)version;
    while (!result && !ended)
        result = sbi_medit_binary_section(medit, &ended);
    return result;
}

SBI_API sb_result sbi_medit_read(sbi_loader *loader)
{
    static const sbi_word references = {"references of vertices", 22};
    sbi_medit medit;
    sbi_word keyword;
    int ended = 0;
    sb_result result = SB_OK;
    memset(&medit, 0, sizeof medit);
    medit.loader = loader;
    medit.reader = &loader->reader;
    if (sbi_medit_is_binary(loader->reader.data, loader->reader.size)) {
        result = sbi_medit_read_binary(&medit);
    } else {
        loader->reader.comment = '#';
        while (!result && !ended && sbi_reader_word(medit.reader, &keyword))
            result = sbi_medit_text_section(&medit, keyword, &ended);
    }
    if (!result && !loader->node_count)
        return sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "the file has no Vertices");
    if (!result && medit.vertex_references)
        sbi_loader_ignore(loader, references);
    return result;
}
