/* meshio_vtk: reads legacy VTK files, versions 2.0 to 5.1, ASCII and binary (which is always big-endian).
 * Source of the format: "VTK File Formats", The VTK User's Guide. Since 5.0 cells are lists of offsets and
 * of node indices; before, each cell's indices follow their count. */
#include "meshio_reader.h"

#include <limits.h>
#include <math.h>
#include <string.h>

/* A type of values, as spelled in the file. */
typedef struct sbi_vtk_type {
    char name[20];
    char class_; /* i signed, u unsigned, f floating, b bits, s text of one line each */
    int size;    /* bytes in binary files */
} sbi_vtk_type;

typedef struct sbi_vtk {
    sbi_loader *loader;
    sbi_reader *reader;
    int binary, polydata;
    int image; /* STRUCTURED_POINTS, and the loader wants an image */
    int has_points, has_cells, has_types;
    int cell_count; /* cells of the list read last, which lie in: */
    int *ends;      /* [cell_count] where the nodes of each cell end */
    int *nodes;
    int category; /* polydata: the last section; cell data counts vertices, lines, polygons, strips */
    int out_of_order;
    int in_cell_data;
    int data_count; /* tuples of the point or cell data being read; -1: outside */
} sbi_vtk;

static const sbi_vtk_type *sbi_vtk_find_type(sbi_word word)
{
    /* vtkIdType is written as a 32-bit integer. */
    static const sbi_vtk_type types[] = {{"float", 'f', 4},
                                         {"double", 'f', 8},
                                         {"int", 'i', 4},
                                         {"unsigned_int", 'u', 4},
                                         {"vtktypeint64", 'i', 8},
                                         {"vtktypeuint64", 'u', 8},
                                         {"vtkIdType", 'i', 4},
                                         {"long", 'i', 8},
                                         {"unsigned_long", 'u', 8},
                                         {"short", 'i', 2},
                                         {"unsigned_short", 'u', 2},
                                         {"char", 'i', 1},
                                         {"signed_char", 'i', 1},
                                         {"unsigned_char", 'u', 1},
                                         {"vtktypeint32", 'i', 4},
                                         {"vtktypeuint32", 'u', 4},
                                         {"vtktypeint16", 'i', 2},
                                         {"vtktypeuint16", 'u', 2},
                                         {"vtktypeint8", 'i', 1},
                                         {"vtktypeuint8", 'u', 1},
                                         {"long_long", 'i', 8},
                                         {"unsigned_long_long", 'u', 8},
                                         {"bit", 'b', 0},
                                         {"string", 's', 0},
                                         {"utf8_string", 's', 0},
                                         {"variant", 's', 0}};
    for (size_t i = 0; i < sizeof types / sizeof types[0]; i++)
        if (sbi_word_is(word, types[i].name))
            return &types[i];
    return NULL;
}

static sb_result sbi_vtk_read_type(sbi_vtk *vtk, const sbi_vtk_type **type)
{
    sbi_word word;
    char text[32];
    if (!sbi_reader_line_word(vtk->reader, &word))
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the data type is missing");
    *type = sbi_vtk_find_type(word);
    if (!*type)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "'%s' is not a data type", sbi_word_print(word, text));
    return SB_OK;
}

/* ---- values ---- */

/* Steps to the data behind a keyword line. */
static void sbi_vtk_start_data(sbi_vtk *vtk)
{
    if (vtk->binary)
        sbi_reader_next_line(vtk->reader);
}

/* Bytes a value takes at least: a digit and a blank in a text. */
static size_t sbi_vtk_value_bytes(const sbi_vtk *vtk, const sbi_vtk_type *type)
{
    return vtk->binary ? (size_t)type->size : 2;
}

static sb_result sbi_vtk_real(sbi_vtk *vtk, const sbi_vtk_type *type, const char *what, double *value)
{
    const unsigned char *bytes;
    if (!vtk->binary)
        return sbi_reader_real(vtk->reader, what, value);
    bytes = sbi_reader_bytes(vtk->reader, 1, (size_t)type->size, what);
    if (!bytes)
        return SB_ERROR_FORMAT;
    if (type->class_ == 'f')
        *value = sbi_decode_float(vtk->reader, bytes, type->size);
    else if (type->class_ == 'i')
        *value = (double)sbi_decode_signed(vtk->reader, bytes, type->size);
    else
        *value = (double)sbi_decode_bits(vtk->reader, bytes, type->size);
    return SB_OK;
}

static sb_result sbi_vtk_integer(sbi_vtk *vtk, const sbi_vtk_type *type, const char *what, int64_t *value)
{
    const unsigned char *bytes;
    uint64_t bits;
    if (!vtk->binary)
        return sbi_reader_integer(vtk->reader, what, value);
    bytes = sbi_reader_bytes(vtk->reader, 1, (size_t)type->size, what);
    if (!bytes)
        return SB_ERROR_FORMAT;
    bits = sbi_decode_bits(vtk->reader, bytes, type->size);
    if (type->class_ == 'i')
        *value = sbi_decode_signed(vtk->reader, bytes, type->size);
    else if (bits <= (uint64_t)INT64_MAX)
        *value = (int64_t)bits;
    else
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "%s is too large", what);
    return SB_OK;
}

static sb_result sbi_vtk_skip_values(sbi_vtk *vtk, const sbi_vtk_type *type, int64_t count)
{
    if (type->class_ == 's') {
        if (vtk->binary)
            return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED, "text arrays in binary files are not supported");
        for (sbi_reader_next_line(vtk->reader); count > 0; count--) {
            if (!sbi_reader_left(vtk->reader))
                return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the file ends in a text array");
            sbi_reader_next_line(vtk->reader);
        }
        return SB_OK;
    }
    sbi_vtk_start_data(vtk);
    if ((uint64_t)count > (uint64_t)sbi_reader_left(vtk->reader) * 8)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the file is too short for %lld values", (long long)count);
    if (!vtk->binary)
        return sbi_reader_skip_words(vtk->reader, (size_t)count, "a data array");
    if (type->class_ == 'b')
        return sbi_reader_bytes(vtk->reader, (size_t)(count + 7) / 8, 1, "a data array") ? SB_OK : SB_ERROR_FORMAT;
    return sbi_reader_bytes(vtk->reader, (size_t)count, (size_t)type->size, "a data array") ? SB_OK : SB_ERROR_FORMAT;
}

/* ---- geometry ---- */

static sb_result sbi_vtk_points(sbi_vtk *vtk)
{
    const sbi_vtk_type *type = NULL;
    int64_t claimed = 0;
    int count = 0;
    sb_result result;
    if (vtk->has_points)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "a second POINTS section");
    result = sbi_reader_integer(vtk->reader, "the number of points", &claimed);
    if (!result)
        result = sbi_vtk_read_type(vtk, &type);
    if (!result && (type->class_ == 'b' || type->class_ == 's'))
        return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED, "points of type %s", type->name);
    if (result)
        return result;
    sbi_vtk_start_data(vtk);
    result = sbi_reader_check_count(vtk->reader, "the number of points", claimed, 3 * sbi_vtk_value_bytes(vtk, type),
                                    &count);
    if (!result)
        result = sbi_loader_reserve_nodes(vtk->loader, count);
    for (int i = 0; i < count && !result; i++) {
        double x[3] = {0, 0, 0};
        vtk->reader->node = i;
        for (int k = 0; k < 3 && !result; k++)
            result = sbi_vtk_real(vtk, type, "coordinate", &x[k]);
        if (!result)
            result = sbi_loader_add_node(vtk->loader, x);
    }
    vtk->has_points = 1;
    return result;
}

static void sbi_vtk_free_list(sbi_vtk *vtk)
{
    sbi_free(&vtk->loader->allocator, vtk->ends);
    sbi_free(&vtk->loader->allocator, vtk->nodes);
    vtk->ends = vtk->nodes = NULL;
    vtk->cell_count = 0;
}

/* Memory for a list of cells with `indices` node indices together. */
static sb_result sbi_vtk_take_list(sbi_vtk *vtk, int cells, int indices)
{
    if (cells > INT_MAX - vtk->loader->source_count)
        return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 cells");
    vtk->ends = (int *)sbi_alloc(&vtk->loader->allocator, (size_t)cells, sizeof(int));
    vtk->nodes = (int *)sbi_alloc(&vtk->loader->allocator, (size_t)indices, sizeof(int));
    vtk->cell_count = cells;
    return vtk->ends && vtk->nodes ? SB_OK : sbi_loader_no_memory(vtk->loader);
}

static sb_result sbi_vtk_node_index(sbi_vtk *vtk, const sbi_vtk_type *type, int *node)
{
    int64_t value = 0;
    sb_result result = sbi_vtk_integer(vtk, type, "node index", &value);
    if (result)
        return result;
    if (value < 0 || value >= (int64_t)vtk->loader->node_count)
        return sbi_reader_fail(vtk->reader, SB_ERROR_INDEX, "cell %d refers to node %lld, but there are %llu nodes",
                               vtk->reader->element, (long long)value, (unsigned long long)vtk->loader->node_count);
    *node = (int)value;
    return SB_OK;
}

/* n times: count, node, node ...; `size` numbers together. */
static sb_result sbi_vtk_counted_list(sbi_vtk *vtk, int64_t claimed_cells, int64_t claimed_size)
{
    static const sbi_vtk_type type = {"int", 'i', 4};
    int cells = 0, size = 0, used = 0, left;
    sb_result result;
    sbi_vtk_start_data(vtk);
    result = sbi_reader_check_count(vtk->reader, "the number of cells", claimed_cells, sbi_vtk_value_bytes(vtk, &type),
                                    &cells);
    if (!result)
        result = sbi_reader_check_count(vtk->reader, "the size of the cell list", claimed_size,
                                        sbi_vtk_value_bytes(vtk, &type), &size);
    if (!result && size < cells)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "a list of %d numbers cannot hold %d cells", size, cells);
    if (!result)
        result = sbi_vtk_take_list(vtk, cells, size - cells);
    left = size - cells;
    for (int i = 0; i < cells && !result; i++) {
        int64_t count = 0;
        vtk->reader->element = vtk->loader->source_count + i;
        result = sbi_vtk_integer(vtk, &type, "the number of nodes of a cell", &count);
        if (!result && (count < 0 || count > left - used))
            return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT,
                                   "cell %d has %lld nodes, which does not fit the size of the list, %d",
                                   vtk->reader->element, (long long)count, size);
        for (int64_t k = 0; k < count && !result; k++)
            result = sbi_vtk_node_index(vtk, &type, &vtk->nodes[used++]);
        if (!result)
            vtk->ends[i] = used;
    }
    if (!result && used != left)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the cells take %d numbers, but the list should have %d",
                               cells + used, size);
    vtk->reader->element = -1;
    return result;
}

/* The keyword of an array of a 5.x list and its integer type. */
static sb_result sbi_vtk_list_array(sbi_vtk *vtk, const char *keyword, const sbi_vtk_type **type)
{
    sbi_word word;
    sb_result result;
    if (!sbi_reader_word(vtk->reader, &word) || !sbi_word_is(word, keyword))
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "%s is missing", keyword);
    result = sbi_vtk_read_type(vtk, type);
    if (!result && (*type)->class_ != 'i' && (*type)->class_ != 'u')
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "%s of type %s", keyword, (*type)->name);
    if (!result)
        sbi_vtk_start_data(vtk);
    return result;
}

/* OFFSETS: one number more than cells, from 0, ascending; then CONNECTIVITY. */
static sb_result sbi_vtk_offset_list(sbi_vtk *vtk, int64_t claimed_offsets, int64_t claimed_indices)
{
    const sbi_vtk_type *type = NULL;
    int offsets = 0, indices = 0;
    int64_t last = 0;
    sb_result result = sbi_vtk_list_array(vtk, "OFFSETS", &type);
    if (!result)
        result = sbi_reader_check_count(vtk->reader, "the number of offsets", claimed_offsets,
                                        sbi_vtk_value_bytes(vtk, type), &offsets);
    if (!result)
        result = sbi_reader_check_count(vtk->reader, "the number of node indices", claimed_indices, vtk->binary ? 1 : 2,
                                        &indices);
    if (!result && offsets == 0)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "a list of cells without offsets");
    if (!result)
        result = sbi_vtk_take_list(vtk, offsets - 1, indices);
    for (int i = 0; i < offsets && !result; i++) {
        int64_t offset = 0;
        vtk->reader->element = vtk->loader->source_count + (i > 0 ? i - 1 : 0);
        result = sbi_vtk_integer(vtk, type, "offset", &offset);
        if (!result && (offset < last || offset > indices || (i == 0 && offset != 0)))
            return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "offset %d is %lld, which is out of order or range", i,
                                   (long long)offset);
        last = offset;
        if (i > 0 && !result)
            vtk->ends[i - 1] = (int)offset;
    }
    vtk->reader->element = -1;
    if (!result && last != indices)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the last offset is %lld, but there are %d node indices",
                               (long long)last, indices);
    if (!result)
        result = sbi_vtk_list_array(vtk, "CONNECTIVITY", &type);
    for (int i = 0, cell = 0; i < indices && !result; i++) {
        while (vtk->ends[cell] <= i)
            cell++;
        vtk->reader->element = vtk->loader->source_count + cell;
        result = sbi_vtk_node_index(vtk, type, &vtk->nodes[i]);
    }
    vtk->reader->element = -1;
    return result;
}

/* A list of cells in either form, after its keyword. */
static sb_result sbi_vtk_cell_list(sbi_vtk *vtk)
{
    int64_t cells = 0, size = 0;
    sbi_word word;
    sb_result result = sbi_reader_integer(vtk->reader, "the number of cells", &cells);
    if (!result)
        result = sbi_reader_integer(vtk->reader, "the size of the cell list", &size);
    if (result)
        return result;
    if (!vtk->has_points)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "cells before POINTS");
    /* In a binary file, bytes that read OFFSETS would be an impossible number of nodes. */
    if (sbi_reader_peek(vtk->reader, &word) && sbi_word_is(word, "OFFSETS"))
        return sbi_vtk_offset_list(vtk, cells, size);
    return sbi_vtk_counted_list(vtk, cells, size);
}

/* Hands cell i of the list to the loader. */
static sb_result sbi_vtk_commit_cell(sbi_vtk *vtk, int i, int kind)
{
    sb_result result = SB_OK;
    sbi_loader_begin_cell(vtk->loader);
    for (int k = i ? vtk->ends[i - 1] : 0; k < vtk->ends[i] && !result; k++)
        result = sbi_loader_cell_node(vtk->loader, vtk->nodes[k], 0);
    return result ? result : sbi_loader_end_vtk_cell(vtk->loader, kind);
}

static sb_result sbi_vtk_cell_types(sbi_vtk *vtk)
{
    static const sbi_vtk_type type = {"int", 'i', 4};
    int64_t claimed = 0;
    sb_result result = sbi_reader_integer(vtk->reader, "the number of cell types", &claimed);
    if (result)
        return result;
    if (!vtk->has_cells || vtk->has_types)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "CELL_TYPES without CELLS before it");
    if (claimed != vtk->cell_count)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "%lld cell types for %d cells", (long long)claimed,
                               vtk->cell_count);
    sbi_vtk_start_data(vtk);
    for (int i = 0; i < vtk->cell_count && !result; i++) {
        int64_t number = 0;
        int kind;
        vtk->reader->element = i;
        result = sbi_vtk_integer(vtk, &type, "cell type", &number);
        kind = sbi_cell_kind_of_vtk(number);
        if (!result && kind < 0)
            return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED, "cell %d has the unknown VTK type %lld", i,
                                   (long long)number);
        if (!result)
            result = sbi_vtk_commit_cell(vtk, i, kind);
    }
    sbi_vtk_free_list(vtk);
    vtk->reader->element = -1;
    vtk->has_types = 1;
    return result;
}

static sb_result sbi_vtk_cells(sbi_vtk *vtk)
{
    if (vtk->has_cells || vtk->polydata)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "CELLS where none should be");
    vtk->has_cells = 1;
    return sbi_vtk_cell_list(vtk);
}

/* A section of polydata whose cells are all of the VTK type. */
static sb_result sbi_vtk_poly_cells(sbi_vtk *vtk, int category, int vtk_type)
{
    sb_result result;
    if (!vtk->polydata)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "a section of POLYDATA in another data set");
    if (category <= vtk->category)
        vtk->out_of_order = 1;
    vtk->category = category;
    result = sbi_vtk_cell_list(vtk);
    for (int i = 0; i < vtk->cell_count && !result; i++)
        result = sbi_vtk_commit_cell(vtk, i, sbi_cell_kind_of_vtk(vtk_type));
    sbi_vtk_free_list(vtk);
    vtk->has_cells = vtk->has_types = 1;
    return result;
}

/* ---- data arrays ---- */

static sb_result sbi_vtk_read_regions(sbi_vtk *vtk, sbi_word name, const sbi_vtk_type *type)
{
    sb_result result;
    if (vtk->out_of_order)
        return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED,
                               "regions of polydata whose sections are not in the order of VTK");
    result = sbi_loader_begin_regions(vtk->loader);
    if (result)
        return result;
    sbi_vtk_start_data(vtk);
    for (int i = 0; i < vtk->loader->source_count && !result; i++) {
        double value = 0;
        vtk->reader->element = i;
        result = sbi_vtk_real(vtk, type, "region", &value);
        if (!result)
            result = sbi_loader_set_region(vtk->loader, name, i, value);
    }
    vtk->reader->element = -1;
    return result;
}

/* The values of an array of a label image: the first one of one number per voxel are the labels. factor: 1, or more
 * where the file has shares of it. */
static sb_result sbi_vtk_image_array(sbi_vtk *vtk, sbi_word name, const sbi_vtk_type *type, int64_t components,
                                     int64_t tuples, double factor)
{
    sbi_loader *loader = vtk->loader;
    int usable = vtk->data_count >= 0 && type->class_ != 'b' && type->class_ != 's' && components == 1;
    int count = 0;
    sb_result result;
    if (!usable || !name.length || tuples != vtk->data_count || loader->voxels->labels)
        return sbi_vtk_skip_values(vtk, type, components * tuples);
    sbi_vtk_start_data(vtk);
    result =
        sbi_reader_check_count(vtk->reader, "the number of voxels", tuples, sbi_vtk_value_bytes(vtk, type), &count);
    if (!result)
        result = sbi_voxels_begin(loader, vtk->in_cell_data);
    for (int i = 0; i < count && !result; i++) {
        double value = 0;
        result = sbi_vtk_real(vtk, type, "label", &value);
        if (!result)
            result = sbi_voxels_set(loader, vtk->reader, i, factor > 1 ? floor(factor * value + 0.5) : value);
    }
    return result;
}

/* The values of an array, after its keyword line up to the type: regions are kept, others skipped. */
static sb_result sbi_vtk_array(sbi_vtk *vtk, sbi_word name, const sbi_vtk_type *type, int64_t components,
                               int64_t tuples)
{
    int of_cells = vtk->in_cell_data && vtk->data_count >= 0, is_number = type->class_ != 'b' && type->class_ != 's';
    int usable = is_number && components == 1 && tuples == vtk->loader->source_count;
    if (components < 0 || tuples < 0 || components > INT_MAX || tuples > INT_MAX)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "an array of %lld times %lld values", (long long)tuples,
                               (long long)components);
    if (vtk->image)
        return sbi_vtk_image_array(vtk, name, type, components, tuples, 1);
    if (of_cells && sbi_word_is(name, "region") && (components != 1 || tuples != vtk->loader->source_count))
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the field region must have one value per cell");
    if (of_cells && sbi_word_is(name, "region") && !is_number)
        return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED, "regions of type %s", type->name);
    usable = usable && (!vtk->out_of_order || sbi_word_is(name, "region"));
    if (of_cells && name.length && sbi_loader_choose_regions(vtk->loader, name, usable))
        return sbi_vtk_read_regions(vtk, name, type);
    if (vtk->data_count >= 0 && !of_cells && name.length)
        sbi_loader_ignore(vtk->loader, name);
    return sbi_vtk_skip_values(vtk, type, components * tuples);
}

/* A line of information, up to the next blank line. */
static void sbi_vtk_metadata(sbi_vtk *vtk)
{
    do
        sbi_reader_next_line(vtk->reader);
    while (sbi_reader_left(vtk->reader) && !sbi_reader_at_line_end(vtk->reader));
}

static sb_result sbi_vtk_field(sbi_vtk *vtk)
{
    sbi_word name;
    int arrays = 0;
    sb_result result;
    if (!sbi_reader_line_word(vtk->reader, &name))
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "FIELD without a name");
    result = sbi_reader_count(vtk->reader, "the number of arrays", 2, &arrays);
    for (int i = 0; i < arrays && !result;) {
        const sbi_vtk_type *type = NULL;
        int64_t components = 0, tuples = 0;
        if (!sbi_reader_word(vtk->reader, &name))
            return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the file ends in FIELD");
        if (sbi_word_is(name, "METADATA")) {
            sbi_vtk_metadata(vtk);
            continue;
        }
        i++;
        if (sbi_word_is(name, "NULL_ARRAY"))
            continue;
        result = sbi_reader_integer(vtk->reader, "the number of components", &components);
        if (!result)
            result = sbi_reader_integer(vtk->reader, "the number of tuples", &tuples);
        if (!result)
            result = sbi_vtk_read_type(vtk, &type);
        if (!result)
            result = sbi_vtk_array(vtk, name, type, components, tuples);
    }
    return result;
}

/* Steps over the line LOOKUP_TABLE that follows a SCALARS line. */
static void sbi_vtk_skip_table_name(sbi_vtk *vtk)
{
    static const char keyword[] = "LOOKUP_TABLE";
    sbi_word word;
    sbi_reader ahead = *vtk->reader;
    sbi_reader_next_line(&ahead);
    if (!vtk->binary)
        sbi_reader_at_line_end(&ahead); /* steps over blanks; binary data may begin with bytes that look like them */
    word.text = ahead.data + ahead.at;
    word.length = sizeof keyword - 1;
    if (sbi_reader_left(&ahead) <= word.length || !sbi_word_is(word, keyword))
        return;
    vtk->reader->at = ahead.at + word.length;
    vtk->reader->line = ahead.line;
    if (!vtk->binary)
        sbi_reader_next_line(vtk->reader);
}

static sb_result sbi_vtk_scalars(sbi_vtk *vtk, sbi_word name)
{
    const sbi_vtk_type *type = NULL;
    int64_t components = 1;
    sb_result result = sbi_vtk_read_type(vtk, &type);
    if (!result && !sbi_reader_at_line_end(vtk->reader))
        result = sbi_reader_integer(vtk->reader, "the number of components", &components);
    if (result)
        return result;
    sbi_vtk_skip_table_name(vtk);
    return sbi_vtk_array(vtk, name, type, components, vtk->data_count);
}

/* COLOR_SCALARS and LOOKUP_TABLE: bytes in binary files, numbers in [0, 1] else. */
static sb_result sbi_vtk_colours(sbi_vtk *vtk, sbi_word name, int is_table)
{
    static const sbi_vtk_type bytes = {"unsigned_char", 'u', 1};
    int64_t count = 0;
    sb_result result = sbi_reader_integer(vtk->reader, "the number of colours", &count);
    if (result)
        return result;
    if (vtk->image && !is_table && count == 1) /* how VTK writes unsigned char: labels from 0 to 255 */
        return sbi_vtk_image_array(vtk, name, &bytes, 1, vtk->data_count, vtk->binary ? 1 : 255);
    name.length = 0; /* colours are no regions, whatever their name */
    return sbi_vtk_array(vtk, name, &bytes, is_table ? 4 : count, is_table ? count : vtk->data_count);
}

static sb_result sbi_vtk_tuples(sbi_vtk *vtk, sbi_word name, int64_t components)
{
    const sbi_vtk_type *type = NULL;
    sb_result result = SB_OK;
    if (components < 0) /* texture coordinates state their own */
        result = sbi_reader_integer(vtk->reader, "the number of components", &components);
    if (!result)
        result = sbi_vtk_read_type(vtk, &type);
    return result ? result : sbi_vtk_array(vtk, name, type, components, vtk->data_count);
}

/* A data array, after its keyword; 0 in *known when the keyword is none of an array. */
static sb_result sbi_vtk_attribute(sbi_vtk *vtk, sbi_word keyword, int *known)
{
    static const struct {
        char keyword[20];
        int components;
    } tuples[] = {{"VECTORS", 3},    {"NORMALS", 3},    {"TENSORS", 9},      {"TENSORS6", 6},
                  {"GLOBAL_IDS", 1}, {"EDGE_FLAGS", 1}, {"PEDIGREE_IDS", 1}, {"TEXTURE_COORDINATES", -1}};
    int is_table = sbi_word_is(keyword, "LOOKUP_TABLE"), scalars = sbi_word_is(keyword, "SCALARS");
    int colours = is_table || sbi_word_is(keyword, "COLOR_SCALARS"), row = -1;
    sbi_word name;
    for (int i = 0; i < (int)(sizeof tuples / sizeof tuples[0]); i++)
        if (sbi_word_is(keyword, tuples[i].keyword))
            row = i;
    *known = scalars || colours || row >= 0;
    if (!*known)
        return SB_OK;
    if (vtk->data_count < 0)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "an array before POINT_DATA or CELL_DATA");
    if (!sbi_reader_line_word(vtk->reader, &name))
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "an array without a name");
    if (scalars)
        return sbi_vtk_scalars(vtk, name);
    return colours ? sbi_vtk_colours(vtk, name, is_table) : sbi_vtk_tuples(vtk, name, tuples[row].components);
}

/* POINT_DATA or CELL_DATA. */
static sb_result sbi_vtk_data(sbi_vtk *vtk, int of_cells)
{
    int64_t count = 0, expected = of_cells ? vtk->loader->source_count : (int64_t)vtk->loader->node_count;
    sb_result result;
    if (vtk->image) {
        expected = sbi_voxels_count(vtk->loader->voxels, of_cells);
        if (expected == 0)
            return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "data before DIMENSIONS");
    }
    result = sbi_reader_integer(vtk->reader, "the number of values", &count);
    if (!result && count != expected)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "data of %lld %s, but there are %lld", (long long)count,
                               of_cells ? "cells" : "points", (long long)expected);
    vtk->in_cell_data = of_cells;
    vtk->data_count = (int)expected;
    return result;
}

/* ---- images ---- */

static sb_result sbi_vtk_dimensions(sbi_vtk *vtk)
{
    sbi_voxels *voxels = vtk->loader->voxels;
    int points[3] = {0, 0, 0};
    sb_result result = SB_OK;
    if (voxels->points[0])
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "a second DIMENSIONS");
    for (int k = 0; k < 3 && !result; k++) {
        result = sbi_reader_count(vtk->reader, "a dimension", 0, &points[k]);
        if (!result && points[k] < 1)
            return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "a dimension is 0");
    }
    if (result)
        return result;
    memcpy(voxels->points, points, sizeof points);
    if (sbi_voxels_count(voxels, 0) == 0)
        return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 voxels");
    return SB_OK;
}

/* The sections of STRUCTURED_POINTS that other data sets do not have; 0 in *known: it is none of them. */
static sb_result sbi_vtk_image_section(sbi_vtk *vtk, sbi_word keyword, int *known)
{
    sbi_voxels *voxels = vtk->loader->voxels;
    sb_result result;
    *known = 1;
    if (sbi_word_is(keyword, "DIMENSIONS"))
        return sbi_vtk_dimensions(vtk);
    if (sbi_word_is(keyword, "ORIGIN"))
        return sbi_voxels_read_reals(vtk->reader, "origin", 3, voxels->origin);
    if (sbi_word_is(keyword, "SPACING") || sbi_word_is(keyword, "ASPECT_RATIO")) {
        result = sbi_voxels_read_reals(vtk->reader, "spacing", 3, voxels->spacing);
        return result ? result : sbi_voxels_check_spacing(vtk->reader, voxels->spacing);
    }
    *known = 0;
    return SB_OK;
}

/* ---- file ---- */

/* The sections of meshes; 0 in *known: it is none of them. */
static sb_result sbi_vtk_mesh_section(sbi_vtk *vtk, sbi_word keyword, int *known)
{
    *known = 1;
    if (sbi_word_is(keyword, "POINTS"))
        return sbi_vtk_points(vtk);
    if (sbi_word_is(keyword, "CELLS"))
        return sbi_vtk_cells(vtk);
    if (sbi_word_is(keyword, "CELL_TYPES"))
        return sbi_vtk_cell_types(vtk);
    if (sbi_word_is(keyword, "VERTICES"))
        return sbi_vtk_poly_cells(vtk, 1, 2);
    if (sbi_word_is(keyword, "LINES"))
        return sbi_vtk_poly_cells(vtk, 2, 4);
    if (sbi_word_is(keyword, "POLYGONS"))
        return sbi_vtk_poly_cells(vtk, 3, 7);
    if (sbi_word_is(keyword, "TRIANGLE_STRIPS"))
        return sbi_vtk_poly_cells(vtk, 4, 6);
    *known = 0;
    return SB_OK;
}

static sb_result sbi_vtk_section(sbi_vtk *vtk, sbi_word keyword)
{
    char text[32];
    int known = 0;
    sb_result result =
        vtk->image ? sbi_vtk_image_section(vtk, keyword, &known) : sbi_vtk_mesh_section(vtk, keyword, &known);
    if (known)
        return result;
    if (sbi_word_is(keyword, "CELL_DATA"))
        return sbi_vtk_data(vtk, 1);
    if (sbi_word_is(keyword, "POINT_DATA"))
        return sbi_vtk_data(vtk, 0);
    if (sbi_word_is(keyword, "FIELD"))
        return sbi_vtk_field(vtk);
    if (sbi_word_is(keyword, "METADATA")) {
        sbi_vtk_metadata(vtk);
        return SB_OK;
    }
    result = sbi_vtk_attribute(vtk, keyword, &known);
    if (!known)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "'%s' where a section should begin",
                               sbi_word_print(keyword, text));
    return result;
}

/* "# vtk DataFile Version 3.0" */
static sb_result sbi_vtk_version(sbi_vtk *vtk)
{
    static const char magic[4][9] = {"#", "vtk", "DataFile", "Version"};
    sbi_word word;
    char text[32];
    for (int i = 0; i < 4; i++)
        if (!sbi_reader_line_word(vtk->reader, &word) || !sbi_word_is(word, magic[i]))
            return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT,
                                   "the first line is not \"# vtk DataFile Version\" with a number");
    if (!sbi_reader_line_word(vtk->reader, &word))
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the version number is missing");
    if (word.length < 3 || word.text[1] != '.' || word.text[0] < '2' || word.text[0] > '5')
        return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED, "VTK version %s is not supported: 2.0 to 5.1 are",
                               sbi_word_print(word, text));
    return SB_OK;
}

static sb_result sbi_vtk_header(sbi_vtk *vtk)
{
    sbi_word word;
    char text[32];
    sb_result result = sbi_vtk_version(vtk);
    if (result)
        return result;
    sbi_reader_next_line(vtk->reader);
    sbi_reader_next_line(vtk->reader); /* the title */
    if (!sbi_reader_word(vtk->reader, &word))
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the file ends in its header");
    vtk->binary = sbi_word_is(word, "BINARY");
    if (!vtk->binary && !sbi_word_is(word, "ASCII"))
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "'%s' instead of ASCII or BINARY",
                               sbi_word_print(word, text));
    if (!sbi_reader_word(vtk->reader, &word) || !sbi_word_is(word, "DATASET") ||
        !sbi_reader_line_word(vtk->reader, &word))
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "DATASET is missing");
    vtk->polydata = sbi_word_is(word, "POLYDATA");
    vtk->image = sbi_word_is(word, "STRUCTURED_POINTS");
    if (vtk->image && !vtk->loader->voxels)
        return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED,
                               "data set STRUCTURED_POINTS is an image, not a mesh: sb_image_load reads it, "
                               "sb_image_surface makes a surface of its labels");
    if (!vtk->image && vtk->loader->voxels)
        return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED, "data set %s is no image: sb_mesh_load reads meshes",
                               sbi_word_print(word, text));
    if (!vtk->image && !vtk->polydata && !sbi_word_is(word, "UNSTRUCTURED_GRID"))
        return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED,
                               "data set %s: only UNSTRUCTURED_GRID and POLYDATA are read", sbi_word_print(word, text));
    vtk->reader->binary = vtk->reader->big_endian = vtk->binary;
    return vtk->binary ? SB_OK : sbi_reader_check_text(vtk->reader);
}

static sb_result sbi_vtk_finish(const sbi_vtk *vtk)
{
    if (vtk->image)
        return SB_OK; /* that there are labels is asked of all formats */
    if (!vtk->has_points)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the file ends without POINTS");
    if (!vtk->has_cells)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the file ends without cells");
    if (!vtk->has_types)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the file ends without CELL_TYPES");
    return SB_OK;
}

SBI_API sb_result sbi_vtk_read(sbi_loader *loader)
{
    sbi_vtk vtk;
    sbi_word keyword;
    sb_result result;
    memset(&vtk, 0, sizeof vtk);
    vtk.loader = loader;
    vtk.reader = &loader->reader;
    vtk.data_count = -1;
    result = sbi_vtk_header(&vtk);
    while (!result && sbi_reader_word(vtk.reader, &keyword))
        result = sbi_vtk_section(&vtk, keyword);
    if (!result)
        result = sbi_vtk_finish(&vtk);
    sbi_vtk_free_list(&vtk);
    return result;
}
