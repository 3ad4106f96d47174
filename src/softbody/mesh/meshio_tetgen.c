/* meshio_tetgen: reads TetGen's .node and .ele files. Source of the format: TetGen manual, "File formats". */
#include "meshio_reader.h"

#include <limits.h>

/* An optional count at the end of a header line. */
static sb_result sbi_tetgen_optional(sbi_reader *reader, const char *what, int *count)
{
    return sbi_reader_at_line_end(reader) ? SB_OK : sbi_reader_count(reader, what, 0, count);
}

static sb_result sbi_tetgen_end_row(sbi_reader *reader)
{
    sbi_word word;
    char text[32];
    if (!sbi_reader_line_word(reader, &word))
        return SB_OK;
    return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s' where the line should end", sbi_word_print(word, text));
}

static sb_result sbi_tetgen_end_file(sbi_reader *reader)
{
    sbi_word word;
    char text[32];
    if (!sbi_reader_word(reader, &word))
        return SB_OK;
    return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s' behind the last row", sbi_word_print(word, text));
}

/* Points, dimension, attributes per point, boundary markers (0 or 1); then number, x, y, z, attributes,
 * marker. */
SBI_API sb_result sbi_tetgen_read_nodes(sbi_loader *loader, int64_t *base)
{
    sbi_reader *reader = &loader->reader;
    int count = 0, attributes = 0, markers = 0;
    int64_t dimension = 0;
    sb_result result;
    reader->comment = '#';
    result = sbi_reader_check_text(reader);
    if (!result)
        result = sbi_reader_count(reader, "the number of points", 8, &count);
    if (!result)
        result = sbi_reader_integer(reader, "dimension", &dimension);
    if (!result && dimension != 3)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "points of dimension %lld", (long long)dimension);
    if (!result)
        result = sbi_tetgen_optional(reader, "the number of attributes", &attributes);
    if (!result)
        result = sbi_tetgen_optional(reader, "the number of markers", &markers);
    if (!result)
        result = sbi_tetgen_end_row(reader);
    if (!result && markers > 1)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "%d boundary markers per point", markers);
    if (!result)
        result = sbi_loader_reserve_nodes(loader, count);
    for (int i = 0; i < count && !result; i++) {
        int64_t number = 0;
        reader->node = i;
        result = sbi_reader_integer(reader, "point number", &number);
        if (i == 0)
            *base = number;
        if (!result && (number != *base + i || *base < 0 || *base > 1))
            return sbi_reader_fail(reader, SB_ERROR_FORMAT, "point number %lld: points are numbered from 0 or 1 on",
                                   (long long)number);
        if (!result)
            result = sbi_loader_read_node(loader);
        if (!result)
            result = sbi_reader_skip_words(reader, (size_t)attributes + (size_t)markers, "the attributes of a point");
        if (!result)
            result = sbi_tetgen_end_row(reader);
    }
    reader->node = -1;
    return result ? result : sbi_tetgen_end_file(reader);
}

/* First attribute of a tetrahedron: its region, which TetGen may write as 1 or 1.0. */
static sb_result sbi_tetgen_region(sbi_reader *reader, int *region)
{
    double value = 0;
    sb_result result = sbi_reader_real(reader, "region", &value);
    if (!result && !(value >= INT_MIN && value <= INT_MAX && value == (double)(int)value))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the region is not an integer: %g", value);
    *region = (int)value;
    return result;
}

/* Number of the edge of a straight tet10, in our order, in whose middle the node lies; -1: in none. */
static int sbi_tetgen_edge_of(const sb_vec3 corners[4], sb_vec3 node)
{
    static const int edges[6][2] = {{0, 1}, {1, 2}, {0, 2}, {0, 3}, {1, 3}, {2, 3}};
    for (int edge = 0; edge < 6; edge++) {
        sb_vec3 a = corners[edges[edge][0]], b = corners[edges[edge][1]];
        sb_vec3 middle = sb_v3_madd(a, (sb_real)0.5, sb_v3_sub(b, a));
        /* coordinates in the file may be rounded; no two middles come closer than this for a sound element */
        if (sb_v3_norm(sb_v3_sub(node, middle)) < (sb_real)0.01 * sb_v3_norm(sb_v3_sub(b, a)))
            return edge;
    }
    return -1;
}

/* Brings the nodes of a tet10 into our order. Releases of TetGen differ in theirs, but all put the nodes
 * into the middle of straight edges, so the geometry decides. */
static sb_result sbi_tetgen_sort_tet10(sbi_loader *loader)
{
    sb_vec3 corners[4];
    int sorted[6] = {-1, -1, -1, -1, -1, -1};
    for (int i = 0; i < 4; i++)
        corners[i] = loader->nodes[loader->scratch[i]];
    for (int i = 4; i < 10; i++) {
        int edge = sbi_tetgen_edge_of(corners, loader->nodes[loader->scratch[i]]);
        if (edge < 0 || sorted[edge] >= 0)
            return sbi_reader_fail(&loader->reader, SB_ERROR_MESH,
                                   "the mid-edge nodes of element %d do not lie in the middle of its edges",
                                   loader->reader.element);
        sorted[edge] = loader->scratch[i];
    }
    for (int i = 0; i < 6; i++)
        loader->scratch[4 + i] = sorted[i];
    return SB_OK;
}

static sb_result sbi_tetgen_element(sbi_loader *loader, int corners, int attributes, int64_t base)
{
    sbi_reader *reader = &loader->reader;
    int64_t number = 0;
    int region = 0;
    sb_result result;
    sbi_loader_begin_cell(loader);
    result = sbi_reader_integer(reader, "element number", &number);
    for (int i = 0; i < corners && !result; i++) {
        result = sbi_reader_integer(reader, "point number", &number);
        if (!result)
            result = sbi_loader_cell_node(loader, number, base);
    }
    if (!result && corners == 10)
        result = sbi_tetgen_sort_tet10(loader);
    if (!result && attributes)
        result = sbi_tetgen_region(reader, &region);
    if (!result && attributes)
        result = sbi_reader_skip_words(reader, (size_t)attributes - 1, "the attributes of an element");
    if (!result)
        result = sbi_tetgen_end_row(reader);
    return result ? result
                  : sbi_loader_end_cell(loader, corners == 4 ? SBI_CELL_TET4 : SBI_CELL_TET10, SBI_ORDER_SAME, region);
}

/* Tetrahedra, nodes of each (4 or 10), attributes of each; then number, nodes, attributes. */
SBI_API sb_result sbi_tetgen_read_elements(sbi_loader *loader, int64_t base)
{
    sbi_reader *reader = &loader->reader;
    int count = 0, attributes = 0;
    int64_t corners = 0;
    sb_result result;
    reader->comment = '#';
    result = sbi_reader_check_text(reader);
    if (!result)
        result = sbi_reader_count(reader, "the number of tetrahedra", 10, &count);
    if (!result)
        result = sbi_reader_integer(reader, "the number of nodes of a tetrahedron", &corners);
    if (!result && corners != 4 && corners != 10)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "tetrahedra of %lld nodes", (long long)corners);
    if (!result)
        result = sbi_tetgen_optional(reader, "the number of attributes", &attributes);
    if (!result)
        result = sbi_tetgen_end_row(reader);
    for (int i = 0; i < count && !result; i++)
        result = sbi_tetgen_element(loader, (int)corners, attributes, base);
    reader->element = -1;
    return result ? result : sbi_tetgen_end_file(reader);
}
