/* meshio_vtu: reads VTK's XML files of unstructured grids (.vtu) and polygons (.vtp), serial, of any version: ASCII,
 * base64 inline, appended raw and base64, 32- and 64-bit headers, both byte orders, plain or packed by zlib.
 * Source of the format: "VTK File Formats" (docs.vtk.org), and what VTK and meshio write.
 *
 *     <VTKFile type= byte_order= header_type= compressor=>
 *       <UnstructuredGrid>
 *         <Piece NumberOfPoints= NumberOfCells=>     tags are walked, the arrays that matter noted in a sbi_vtu_array;
 *           <CellData> <Points> <Cells>              at </Piece> they are opened and handed to the loader
 *       <AppendedData encoding=> _ ... */
#include "meshio_reader.h"

#include <limits.h>
#include <math.h>
#include <string.h>

typedef enum sbi_vtu_format { SBI_VTU_ASCII = 0, SBI_VTU_BASE64 = 1, SBI_VTU_RAW = 2 } sbi_vtu_format;

/* A DataArray of the piece. */
typedef struct sbi_vtu_array {
    int present;
    sbi_word name;
    char class_; /* i signed, u unsigned, f floating; 0: something else */
    int size;    /* bytes of a value */
    int components;
    sbi_vtu_format format;
    sbi_reader text; /* bounded: the text between its tags, or appended data from its offset on */
} sbi_vtu_array;

/* The values of an array, one after the other. */
typedef struct sbi_vtu_values {
    const sbi_vtu_array *array;
    sbi_reader reader;          /* ASCII: at the next word; else the array's place for errors */
    const unsigned char *bytes; /* NULL: ASCII */
    unsigned char *owned;
    size_t count, next; /* of bytes */
} sbi_vtu_values;

/* Where in a piece a DataArray lies. Lists of cells come first. */
enum {
    SBI_VTU_CELLS = 0,
    SBI_VTU_VERTS = 1,
    SBI_VTU_LINES = 2,
    SBI_VTU_POLYS = 3,
    SBI_VTU_STRIPS = 4,
    SBI_VTU_LISTS = 5,
    SBI_VTU_POINTS = 5,
    SBI_VTU_POINT_DATA = 6,
    SBI_VTU_CELL_DATA = 7,
    SBI_VTU_ELSEWHERE = 8
};

typedef struct sbi_vtu {
    sbi_loader *loader;
    sbi_xml xml;
    int polydata, header_size, big_endian;
    int image;              /* ImageData, and the loader wants an image */
    int extent[6];          /* of the image: first and last point along each axis */
    int labels_in_cells;    /* where the array lies that `regions` holds */
    int compressed;         /* 1: by zlib, 2: by something else; ASCII arrays never are */
    sbi_word compressor;    /* its name */
    int has_file, has_grid; /* the tags VTKFile and of the data set were met */
    size_t appended;        /* first byte behind the "_"; 0: there is no appended data */
    sbi_vtu_format appended_format;
    int section; /* of the piece, see above */
    int in_piece;
    int point_count, cell_counts[SBI_VTU_LISTS];
    sbi_vtu_array points, types, regions, offsets[SBI_VTU_LISTS], connectivity[SBI_VTU_LISTS];
} sbi_vtu;

/* ---- bytes of an array ---- */

static int sbi_vtu_base64_digit(char c)
{
    if (c >= 'A' && c <= 'Z')
        return c - 'A';
    if (c >= 'a' && c <= 'z')
        return c - 'a' + 26;
    if (c >= '0' && c <= '9')
        return c - '0' + 52;
    return c == '+' ? 62 : c == '/' ? 63 : -1;
}

/* Decodes up to `need` bytes and returns how many there were. Writers encode header and data separately or together:
 * a padded group ends one part, and the next follows. Stops at what is neither a digit nor a blank. */
static size_t sbi_vtu_decode(const char *text, size_t size, size_t need, unsigned char *out)
{
    size_t got = 0;
    unsigned group = 0;
    int digits = 0, padding = 0;
    for (size_t i = 0; i < size && got < need; i++) {
        int digit = sbi_vtu_base64_digit(text[i]), bytes;
        if (text[i] == ' ' || text[i] == '\n' || text[i] == '\r' || text[i] == '\t')
            continue;
        if (text[i] == '=')
            padding++;
        else if (digit < 0 || padding)
            break;
        group = group << 6 | (unsigned)(digit < 0 ? 0 : digit);
        if (++digits < 4)
            continue;
        if (padding > 2)
            break;
        bytes = 3 - padding;
        for (int k = 0; k < bytes && got < need; k++)
            out[got++] = (unsigned char)(group >> (16 - 8 * k) & 0xFF);
        group = 0;
        digits = padding = 0;
    }
    return got;
}

/* The first `need` bytes of an array, fewer when there are no more; *owned is to be freed. NULL without memory. */
static const unsigned char *sbi_vtu_fetch(const sbi_vtu *vtu, const sbi_vtu_array *array, size_t need, size_t *got,
                                          unsigned char **owned)
{
    const char *text = array->text.data + array->text.at;
    size_t left = sbi_reader_left(&array->text), most = left / 4 * 3 + 3;
    *owned = NULL;
    if (array->format == SBI_VTU_RAW) {
        *got = need < left ? need : left;
        return (const unsigned char *)text;
    }
    *owned = (unsigned char *)sbi_alloc(&vtu->loader->allocator, need < most ? need : most, 1);
    if (*owned)
        *got = sbi_vtu_decode(text, left, need < most ? need : most, *owned);
    return *owned;
}

static sb_result sbi_vtu_fail_short(const sbi_vtu_array *array)
{
    char text[32];
    return sbi_reader_fail(&array->text, SB_ERROR_FORMAT, "the data of the array %s is cut off or no base64",
                           sbi_word_print(array->name, text));
}

/* Number i of a header. */
static uint64_t sbi_vtu_header_at(const sbi_vtu *vtu, const sbi_vtu_array *array, const unsigned char *bytes, size_t i)
{
    return sbi_decode_bits(&array->text, bytes + i * (size_t)vtu->header_size, vtu->header_size);
}

/* Takes over the bytes [at, at + size) of what was fetched. */
static void sbi_vtu_keep(sbi_vtu_values *values, const unsigned char *bytes, unsigned char *owned, size_t size)
{
    values->bytes = bytes;
    values->owned = owned;
    values->count = size / (size_t)values->array->size;
}

/* Number of bytes; bytes. */
static sb_result sbi_vtu_open_plain(const sbi_vtu *vtu, sbi_vtu_values *values, uint64_t size)
{
    const sbi_vtu_array *array = values->array;
    size_t head = (size_t)vtu->header_size, got = 0;
    unsigned char *owned;
    const unsigned char *bytes;
    if (size > (uint64_t)sbi_reader_left(&array->text))
        return sbi_vtu_fail_short(array);
    bytes = sbi_vtu_fetch(vtu, array, head + (size_t)size, &got, &owned);
    if (!bytes)
        return sbi_loader_no_memory(vtu->loader);
    if (got < head + (size_t)size) {
        sbi_free(&vtu->loader->allocator, owned);
        return sbi_vtu_fail_short(array);
    }
    sbi_vtu_keep(values, bytes + head, owned, (size_t)size);
    return SB_OK;
}

/* The blocks behind a header: each is a zlib stream of `full` bytes, the last one of `last` unless that is 0. */
static sb_result sbi_vtu_unpack(const sbi_vtu *vtu, sbi_vtu_values *values, const unsigned char *bytes, size_t size,
                                size_t blocks)
{
    const sbi_vtu_array *array = values->array;
    size_t at = (3 + blocks) * (size_t)vtu->header_size, out_size = 0, capacity = 0;
    uint64_t full = sbi_vtu_header_at(vtu, array, bytes, 1), last = sbi_vtu_header_at(vtu, array, bytes, 2);
    unsigned char *out = (unsigned char *)sbi_alloc(&vtu->loader->allocator, 1, 1);
    const char *wrong = out ? NULL : "";
    capacity = 1;
    for (size_t i = 0; i < blocks && !wrong; i++) {
        uint64_t packed = sbi_vtu_header_at(vtu, array, bytes, 3 + i), expected = i + 1 == blocks && last ? last : full;
        size_t before = out_size;
        if (packed > size - at || expected > (uint64_t)((size_t)-1) / 2)
            wrong = "it is cut off";
        else
            wrong = sbi_inflate(&vtu->loader->allocator, bytes + at, (size_t)packed, (size_t)expected, &out, &out_size,
                                &capacity);
        if (!wrong && out_size - before != expected)
            wrong = "it holds less than it announces";
        if (!wrong)
            at += (size_t)packed;
    }
    if (!wrong) {
        sbi_vtu_keep(values, out, out, out_size);
        return SB_OK;
    }
    sbi_free(&vtu->loader->allocator, out);
    if (!wrong[0])
        return sbi_loader_no_memory(vtu->loader);
    return sbi_reader_fail(&array->text, SB_ERROR_FORMAT, "a packed block of the array cannot be unpacked: %s", wrong);
}

/* Number of blocks, sizes of a block and of the last one, packed size of each; blocks. */
static sb_result sbi_vtu_open_packed(const sbi_vtu *vtu, sbi_vtu_values *values, uint64_t blocks)
{
    const sbi_vtu_array *array = values->array;
    size_t head, got = 0, total;
    unsigned char *owned;
    const unsigned char *bytes;
    sb_result result = SB_OK;
    if (blocks == 0) {
        sbi_vtu_keep(values, (const unsigned char *)"", NULL, 0);
        return SB_OK;
    }
    if (blocks > (uint64_t)(sbi_reader_left(&array->text) / (size_t)vtu->header_size))
        return sbi_vtu_fail_short(array);
    head = (3 + (size_t)blocks) * (size_t)vtu->header_size;
    bytes = sbi_vtu_fetch(vtu, array, head, &got, &owned);
    if (!bytes)
        return sbi_loader_no_memory(vtu->loader);
    total = head;
    if (got < head)
        result = sbi_vtu_fail_short(array);
    for (size_t i = 0; i < (size_t)blocks && !result; i++) {
        uint64_t packed = sbi_vtu_header_at(vtu, array, bytes, 3 + i);
        if (packed > (uint64_t)sbi_reader_left(&array->text) || total > (size_t)-1 / 2)
            result = sbi_vtu_fail_short(array);
        else
            total += (size_t)packed;
    }
    sbi_free(&vtu->loader->allocator, owned);
    if (result)
        return result;
    bytes = sbi_vtu_fetch(vtu, array, total, &got, &owned);
    if (!bytes)
        return sbi_loader_no_memory(vtu->loader);
    result = got < total ? sbi_vtu_fail_short(array) : sbi_vtu_unpack(vtu, values, bytes, got, (size_t)blocks);
    sbi_free(&vtu->loader->allocator, owned);
    return result;
}

/* Makes the values of an array readable; to be closed, also after a failure. */
static sb_result sbi_vtu_open(const sbi_vtu *vtu, const sbi_vtu_array *array, sbi_vtu_values *values)
{
    unsigned char *owned;
    const unsigned char *bytes;
    size_t got = 0;
    uint64_t first = 0;
    char text[32];
    memset(values, 0, sizeof *values);
    values->array = array;
    values->reader = array->text;
    if (array->format == SBI_VTU_ASCII)
        return SB_OK;
    if (vtu->compressed == 2)
        return sbi_reader_fail(&array->text, SB_ERROR_UNSUPPORTED,
                               "the data is packed by %s: save it with the compressor none or ZLib",
                               sbi_word_print(vtu->compressor, text));
    bytes = sbi_vtu_fetch(vtu, array, (size_t)vtu->header_size, &got, &owned);
    if (!bytes)
        return sbi_loader_no_memory(vtu->loader);
    if (got == (size_t)vtu->header_size)
        first = sbi_vtu_header_at(vtu, array, bytes, 0);
    sbi_free(&vtu->loader->allocator, owned);
    if (got < (size_t)vtu->header_size)
        return sbi_vtu_fail_short(array);
    return vtu->compressed ? sbi_vtu_open_packed(vtu, values, first) : sbi_vtu_open_plain(vtu, values, first);
}

static void sbi_vtu_close(const sbi_vtu *vtu, sbi_vtu_values *values)
{
    sbi_free(&vtu->loader->allocator, values->owned);
    memset(values, 0, sizeof *values);
}

/* ---- values ---- */

static const unsigned char *sbi_vtu_next(sbi_vtu_values *values, const char *what)
{
    if (values->next >= values->count) {
        sbi_reader_fail(&values->reader, SB_ERROR_FORMAT, "the array ends where %s should be", what);
        return NULL;
    }
    return values->bytes + values->next++ * (size_t)values->array->size;
}

static sb_result sbi_vtu_real(sbi_vtu_values *values, const char *what, double *value)
{
    const sbi_vtu_array *array = values->array;
    const unsigned char *bytes;
    if (!values->bytes)
        return sbi_reader_real(&values->reader, what, value);
    bytes = sbi_vtu_next(values, what);
    if (!bytes)
        return SB_ERROR_FORMAT;
    if (array->class_ == 'f')
        *value = sbi_decode_float(&array->text, bytes, array->size);
    else if (array->class_ == 'i')
        *value = (double)sbi_decode_signed(&array->text, bytes, array->size);
    else
        *value = (double)sbi_decode_bits(&array->text, bytes, array->size);
    return SB_OK;
}

static sb_result sbi_vtu_integer(sbi_vtu_values *values, const char *what, int64_t *value)
{
    const sbi_vtu_array *array = values->array;
    const unsigned char *bytes;
    uint64_t bits;
    if (!values->bytes)
        return sbi_reader_integer(&values->reader, what, value);
    bytes = sbi_vtu_next(values, what);
    if (!bytes)
        return SB_ERROR_FORMAT;
    bits = sbi_decode_bits(&array->text, bytes, array->size);
    if (array->class_ == 'i')
        *value = sbi_decode_signed(&array->text, bytes, array->size);
    else if (bits <= (uint64_t)INT64_MAX)
        *value = (int64_t)bits;
    else
        return sbi_reader_fail(&values->reader, SB_ERROR_FORMAT, "%s is too large", what);
    return SB_OK;
}

/* An error unless the array ends here. */
static sb_result sbi_vtu_expect_end(sbi_vtu_values *values, const char *what)
{
    sbi_word word;
    int more = values->bytes ? values->next < values->count : sbi_reader_word(&values->reader, &word);
    return more ? sbi_reader_fail(&values->reader, SB_ERROR_FORMAT, "the array has more values than %s need", what)
                : SB_OK;
}

/* Whether an array can hold so many values: memory may be taken for them then. */
static sb_result sbi_vtu_check_count(const sbi_vtu_values *values, const char *what, int64_t count)
{
    size_t room = values->bytes ? values->count : (sbi_reader_left(&values->reader) + 1) / 2;
    return (uint64_t)count <= (uint64_t)room
               ? SB_OK
               : sbi_reader_fail(&values->reader, SB_ERROR_FORMAT, "the array is too short for %lld values: %s",
                                 (long long)count, what);
}

/* ---- a piece ---- */

static sb_result sbi_vtu_need(const sbi_vtu *vtu, const sbi_vtu_array *array, const char *name, int only_integers)
{
    if (!array->present)
        return sbi_reader_fail(&vtu->loader->reader, SB_ERROR_FORMAT, "the piece has no array %s", name);
    if (!array->class_ || (only_integers && array->class_ == 'f'))
        return sbi_reader_fail(&array->text, SB_ERROR_FORMAT, "the array %s has a type that does not fit", name);
    return SB_OK;
}

static sb_result sbi_vtu_read_points(sbi_vtu *vtu)
{
    sbi_vtu_values values;
    sbi_loader *loader = vtu->loader;
    sb_result result = sbi_vtu_need(vtu, &vtu->points, "of points", 0);
    if (!result && vtu->points.components != 3)
        return sbi_reader_fail(&vtu->points.text, SB_ERROR_FORMAT, "points with %d components", vtu->points.components);
    if (!result && (size_t)vtu->point_count > (size_t)INT_MAX - loader->node_count)
        return sbi_reader_fail(&loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 nodes");
    if (result)
        return result;
    result = sbi_vtu_open(vtu, &vtu->points, &values);
    if (!result)
        result = sbi_vtu_check_count(&values, "coordinates", 3 * (int64_t)vtu->point_count);
    if (!result)
        result = sbi_loader_reserve_nodes(loader, vtu->point_count);
    for (int i = 0; i < vtu->point_count && !result; i++) {
        double x[3] = {0, 0, 0};
        values.reader.node = (int)loader->node_count;
        for (int k = 0; k < 3 && !result; k++)
            result = sbi_vtu_real(&values, "coordinate", &x[k]);
        loader->reader.line = values.reader.line;
        if (!result)
            result = sbi_loader_add_node(loader, x);
    }
    values.reader.node = -1;
    if (!result)
        result = sbi_vtu_expect_end(&values, "the points");
    sbi_vtu_close(vtu, &values);
    return result;
}

/* The three streams of a list of cells; types are those of Cells only. */
typedef struct sbi_vtu_list {
    sbi_vtu_values offsets, connectivity, types;
    int64_t offset; /* of the cell before */
} sbi_vtu_list;

static sb_result sbi_vtu_read_cell(sbi_vtu *vtu, int list, sbi_vtu_list *read, int base)
{
    static const int kinds[SBI_VTU_LISTS] = {0, 2, 4, 7, 6}; /* VTK's types of the lists of polydata */
    sbi_loader *loader = vtu->loader;
    int64_t end = 0, type = kinds[list], node = 0;
    int kind, cell = loader->source_count;
    sb_result result;
    sbi_loader_begin_cell(loader);
    read->offsets.reader.element = read->connectivity.reader.element = read->types.reader.element = cell;
    result = sbi_vtu_integer(&read->offsets, "offset", &end);
    if (!result && list == SBI_VTU_CELLS)
        result = sbi_vtu_integer(&read->types, "cell type", &type);
    if (result)
        return result;
    kind = sbi_cell_kind_of_vtk(type);
    if (kind < 0)
        return sbi_reader_fail(&read->types.reader, SB_ERROR_UNSUPPORTED, "cell %d has the unknown VTK type %lld", cell,
                               (long long)type);
    if (end < read->offset)
        return sbi_reader_fail(&read->offsets.reader, SB_ERROR_FORMAT,
                               "the offset of cell %d is %lld, less than before", cell, (long long)end);
    for (; read->offset < end && !result; read->offset++) {
        result = sbi_vtu_integer(&read->connectivity, "node index", &node);
        if (!result && (node < 0 || node >= vtu->point_count))
            return sbi_reader_fail(&read->connectivity.reader, SB_ERROR_INDEX,
                                   "cell %d refers to node %lld, but the piece has %d points", cell, (long long)node,
                                   vtu->point_count);
        if (!result)
            result = sbi_loader_cell_node(loader, node + base, 0);
    }
    loader->reader.line = read->connectivity.reader.line;
    return result ? result : sbi_loader_end_vtk_cell(loader, kind);
}

static sb_result sbi_vtu_read_list(sbi_vtu *vtu, int list, int base)
{
    static const char *const names[3] = {"offsets", "connectivity", "types"};
    const sbi_vtu_array *arrays[3];
    sbi_vtu_list read;
    int count = vtu->cell_counts[list];
    sb_result result = SB_OK;
    arrays[0] = &vtu->offsets[list];
    arrays[1] = &vtu->connectivity[list];
    arrays[2] = &vtu->types;
    memset(&read, 0, sizeof read);
    for (int i = 0; i < (list == SBI_VTU_CELLS ? 3 : 2) && !result; i++) {
        result = sbi_vtu_need(vtu, arrays[i], names[i], 1);
        if (!result)
            result = sbi_vtu_open(vtu, arrays[i], i == 0 ? &read.offsets : i == 1 ? &read.connectivity : &read.types);
    }
    for (int i = 0; i < count && !result; i++)
        result = sbi_vtu_read_cell(vtu, list, &read, base);
    read.offsets.reader.element = read.connectivity.reader.element = -1;
    if (!result)
        result = sbi_vtu_expect_end(&read.offsets, "the cells");
    if (!result)
        result = sbi_vtu_expect_end(&read.connectivity, "the cells");
    sbi_vtu_close(vtu, &read.offsets);
    sbi_vtu_close(vtu, &read.connectivity);
    sbi_vtu_close(vtu, &read.types);
    return result;
}

static sb_result sbi_vtu_read_regions(sbi_vtu *vtu, int first)
{
    sbi_loader *loader = vtu->loader;
    sbi_vtu_values values;
    sb_result result;
    if (loader->region_rank == 0 || !vtu->regions.present)
        return loader->source_regions ? sbi_loader_begin_regions(loader) : SB_OK;
    result = sbi_loader_begin_regions(loader);
    if (result)
        return result;
    result = sbi_vtu_open(vtu, &vtu->regions, &values);
    for (int i = first; i < loader->source_count && !result; i++) {
        double value = 0;
        values.reader.element = i;
        result = sbi_vtu_real(&values, "region", &value);
        loader->reader.line = values.reader.line;
        loader->reader.element = i;
        if (!result)
            result = sbi_loader_set_region(loader, vtu->regions.name, i, value);
    }
    loader->reader.element = -1;
    sbi_vtu_close(vtu, &values);
    return result;
}

/* At </Piece>. */
static sb_result sbi_vtu_read_piece(sbi_vtu *vtu)
{
    sbi_loader *loader = vtu->loader;
    int base = (int)loader->node_count, first = loader->source_count, line = loader->reader.line;
    sb_result result = vtu->point_count > 0 ? sbi_vtu_read_points(vtu) : SB_OK;
    for (int list = 0; list < SBI_VTU_LISTS && !result; list++)
        if (vtu->cell_counts[list] > 0)
            result = sbi_vtu_read_list(vtu, list, base);
    if (!result)
        result = sbi_vtu_read_regions(vtu, first);
    loader->reader.line = line;
    vtu->in_piece = 0;
    loader->pieces += vtu->point_count > 0;
    return result;
}

/* ---- tags ---- */

/* An attribute that is an integer in [0, INT_MAX]; `missing` when there is none. */
static sb_result sbi_vtu_integer_attribute(sbi_vtu *vtu, const char *name, int missing, int *value)
{
    sbi_word word;
    char text[32];
    int64_t parsed = missing;
    if (sbi_xml_attribute(&vtu->xml, name, &word)) {
        while (word.length && (word.text[0] == ' ' || word.text[0] == '\t')) /* some writers pad numbers */
            word.text++, word.length--;
        while (word.length && (word.text[word.length - 1] == ' ' || word.text[word.length - 1] == '\t'))
            word.length--;
        if (sbi_parse_integer(word.text, word.length, &parsed) <= 0 || parsed < 0 || parsed > INT_MAX)
            return sbi_reader_fail(&vtu->loader->reader, SB_ERROR_FORMAT, "%s=\"%s\" is no number from 0 to 2147483647",
                                   name, sbi_word_print(word, text));
    }
    *value = (int)parsed;
    return SB_OK;
}

static sb_result sbi_vtu_file_tag(sbi_vtu *vtu)
{
    sbi_reader *reader = &vtu->loader->reader;
    sbi_word word;
    char text[32];
    vtu->has_file = 1;
    if (!sbi_xml_attribute(&vtu->xml, "type", &word))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "<VTKFile> without a type");
    vtu->polydata = sbi_word_equals(word, "PolyData");
    vtu->image = sbi_word_equals(word, "ImageData");
    if (vtu->image && !vtu->loader->voxels)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED,
                               "ImageData is an image, not a mesh: sb_image_load reads it, sb_image_surface makes a "
                               "surface of its labels");
    if (!vtu->image && vtu->loader->voxels)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "data set %s is no image: sb_mesh_load reads meshes",
                               sbi_word_print(word, text));
    if (!vtu->image && !vtu->polydata && !sbi_word_equals(word, "UnstructuredGrid"))
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED,
                               "VTK XML data set %s: only UnstructuredGrid and PolyData are read",
                               sbi_word_print(word, text));
    if (sbi_xml_attribute(&vtu->xml, "byte_order", &word)) {
        vtu->big_endian = sbi_word_equals(word, "BigEndian");
        if (!vtu->big_endian && !sbi_word_equals(word, "LittleEndian"))
            return sbi_reader_fail(reader, SB_ERROR_FORMAT, "byte_order=\"%s\"", sbi_word_print(word, text));
    }
    vtu->header_size = 4;
    if (sbi_xml_attribute(&vtu->xml, "header_type", &word)) {
        vtu->header_size = sbi_word_equals(word, "UInt64") ? 8 : 4;
        if (vtu->header_size == 4 && !sbi_word_equals(word, "UInt32"))
            return sbi_reader_fail(reader, SB_ERROR_FORMAT, "header_type=\"%s\"", sbi_word_print(word, text));
    }
    if (sbi_xml_attribute(&vtu->xml, "compressor", &vtu->compressor) && vtu->compressor.length)
        vtu->compressed = sbi_word_equals(vtu->compressor, "vtkZLibDataCompressor") ? 1 : 2;
    return SB_OK;
}

/* An attribute of `count` numbers; values stay where there is none. */
static sb_result sbi_vtu_reals_attribute(sbi_vtu *vtu, const char *name, int count, double *values)
{
    sbi_reader text = vtu->loader->reader;
    sbi_word word, more;
    sb_result result;
    if (!sbi_xml_attribute(&vtu->xml, name, &word))
        return SB_OK;
    text.data = word.text;
    text.size = word.length;
    text.at = 0;
    result = sbi_voxels_read_reals(&text, name, count, values);
    if (!result && sbi_reader_word(&text, &more))
        return sbi_reader_fail(&vtu->loader->reader, SB_ERROR_FORMAT, "%s has more than %d numbers", name, count);
    return result;
}

/* An attribute that holds the first and last point along each axis. */
static sb_result sbi_vtu_extent_attribute(sbi_vtu *vtu, const char *name, int extent[6])
{
    double numbers[6] = {0, -1, 0, -1, 0, -1};
    sb_result result = sbi_vtu_reals_attribute(vtu, name, 6, numbers);
    for (int i = 0; i < 6 && !result; i++) {
        if (!(fabs(numbers[i]) < INT_MAX / 2) || floor(numbers[i]) < numbers[i])
            return sbi_reader_fail(&vtu->loader->reader, SB_ERROR_FORMAT, "%s has a number that is no index", name);
        extent[i] = (int)numbers[i];
        if (i % 2 == 1 && extent[i] < extent[i - 1])
            return sbi_reader_fail(&vtu->loader->reader, SB_ERROR_FORMAT, "%s is missing or empty", name);
    }
    return result;
}

/* Origin and Spacing are those of the point (0, 0, 0), which the extent need not have. */
static sb_result sbi_vtu_image_tag(sbi_vtu *vtu)
{
    sbi_voxels *voxels = vtu->loader->voxels;
    double rows[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    sb_result result = sbi_vtu_extent_attribute(vtu, "WholeExtent", vtu->extent);
    if (!result)
        result = sbi_vtu_reals_attribute(vtu, "Origin", 3, voxels->origin);
    if (!result)
        result = sbi_vtu_reals_attribute(vtu, "Spacing", 3, voxels->spacing);
    if (!result)
        result = sbi_vtu_reals_attribute(vtu, "Direction", 9, rows);
    if (!result)
        result = sbi_voxels_check_spacing(&vtu->loader->reader, voxels->spacing);
    for (int axis = 0; axis < 3 && !result; axis++) {
        voxels->points[axis] = vtu->extent[2 * axis + 1] - vtu->extent[2 * axis] + 1;
        for (int k = 0; k < 3; k++)
            voxels->direction[axis][k] = rows[3 * k + axis];
    }
    for (int k = 0; k < 3 && !result; k++)
        for (int axis = 0; axis < 3; axis++)
            voxels->origin[k] += voxels->direction[axis][k] * voxels->spacing[axis] * vtu->extent[2 * axis];
    if (!result && sbi_voxels_count(voxels, 0) == 0)
        return sbi_reader_fail(&vtu->loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 voxels");
    return result;
}

static sb_result sbi_vtu_image_piece_tag(sbi_vtu *vtu)
{
    int extent[6] = {0, 0, 0, 0, 0, 0};
    sb_result result = sbi_vtu_extent_attribute(vtu, "Extent", extent);
    if (!result && memcmp(extent, vtu->extent, sizeof extent) != 0)
        return sbi_reader_fail(&vtu->loader->reader, SB_ERROR_UNSUPPORTED,
                               "an image in several pieces: save it as one piece");
    return result;
}

/* At </Piece>: the array that was noted becomes the labels. */
static sb_result sbi_vtu_read_image(sbi_vtu *vtu)
{
    sbi_loader *loader = vtu->loader;
    sbi_vtu_values values;
    int count = sbi_voxels_count(loader->voxels, vtu->labels_in_cells);
    sb_result result;
    vtu->in_piece = 0;
    if (!vtu->regions.present || loader->voxels->labels)
        return SB_OK;
    result = sbi_vtu_open(vtu, &vtu->regions, &values);
    if (!result)
        result = sbi_vtu_check_count(&values, "labels", count);
    if (!result)
        result = sbi_voxels_begin(loader, vtu->labels_in_cells);
    for (int i = 0; i < count && !result; i++) {
        double value = 0;
        result = sbi_vtu_real(&values, "label", &value);
        if (!result)
            result = sbi_voxels_set(loader, &values.reader, i, value);
    }
    if (!result)
        result = sbi_vtu_expect_end(&values, "the voxels");
    sbi_vtu_close(vtu, &values);
    return result;
}

static sb_result sbi_vtu_piece_tag(sbi_vtu *vtu)
{
    static const char *const counts[SBI_VTU_LISTS] = {"NumberOfCells", "NumberOfVerts", "NumberOfLines",
                                                      "NumberOfPolys", "NumberOfStrips"};
    sb_result result;
    if (!vtu->has_grid || vtu->in_piece)
        return sbi_reader_fail(&vtu->loader->reader, SB_ERROR_FORMAT, "<Piece> where none should be");
    vtu->in_piece = 1;
    vtu->section = SBI_VTU_ELSEWHERE;
    vtu->points.present = vtu->types.present = vtu->regions.present = 0;
    if (vtu->image)
        return sbi_vtu_image_piece_tag(vtu);
    result = sbi_vtu_integer_attribute(vtu, "NumberOfPoints", 0, &vtu->point_count);
    for (int i = 0; i < SBI_VTU_LISTS && !result; i++) {
        vtu->offsets[i].present = vtu->connectivity[i].present = 0;
        vtu->cell_counts[i] = 0;
        if ((i > 0) == vtu->polydata)
            result = sbi_vtu_integer_attribute(vtu, counts[i], 0, &vtu->cell_counts[i]);
    }
    return result;
}

/* Type, components and place of the values. */
static sb_result sbi_vtu_array_tag(sbi_vtu *vtu, sbi_vtu_array *array)
{
    static const char types[10][8] = {"Int8",   "Int16",  "Int32",  "Int64",   "UInt8",
                                      "UInt16", "UInt32", "UInt64", "Float32", "Float64"};
    sbi_reader *reader = &vtu->loader->reader;
    const char *end;
    sbi_word word;
    char text[32];
    int64_t offset = 0;
    sb_result result;
    memset(array, 0, sizeof *array);
    array->present = 1;
    array->name.text = "";
    sbi_xml_attribute(&vtu->xml, "Name", &array->name);
    array->size = 1;
    for (int i = 0; i < 10 && sbi_xml_attribute(&vtu->xml, "type", &word); i++)
        if (sbi_word_equals(word, types[i])) {
            array->class_ = i < 4 ? 'i' : i < 8 ? 'u' : 'f';
            array->size = i < 8 ? 1 << (i % 4) : i == 8 ? 4 : 8;
        }
    result = sbi_vtu_integer_attribute(vtu, "NumberOfComponents", 1, &array->components);
    if (result)
        return result;
    array->text = *reader;
    array->text.big_endian = vtu->big_endian;
    end = reader->at < reader->size ? (const char *)memchr(reader->data + reader->at, '<', sbi_reader_left(reader))
                                    : NULL;
    array->text.size = end ? (size_t)(end - reader->data) : reader->size;
    if (!sbi_xml_attribute(&vtu->xml, "format", &word) || sbi_word_is(word, "ascii"))
        return SB_OK;
    array->format = SBI_VTU_BASE64;
    if (sbi_word_is(word, "binary"))
        return SB_OK;
    if (!sbi_word_is(word, "appended"))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "format=\"%s\"", sbi_word_print(word, text));
    array->format = vtu->appended_format;
    if (!sbi_xml_attribute(&vtu->xml, "offset", &word) || sbi_parse_integer(word.text, word.length, &offset) <= 0 ||
        offset < 0 || vtu->appended == 0 || (uint64_t)offset > (uint64_t)(reader->size - vtu->appended))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the offset of an array lies outside the appended data");
    array->text.at = vtu->appended + (size_t)offset;
    array->text.size = reader->size;
    return SB_OK;
}

/* Which array of the piece this is; NULL: none that matters. */
static sbi_vtu_array *sbi_vtu_find_array(sbi_vtu *vtu, sbi_word name)
{
    int section = vtu->section;
    if (section == SBI_VTU_POINTS)
        return vtu->points.present ? NULL : &vtu->points;
    if (section < SBI_VTU_LISTS && sbi_word_equals(name, "connectivity"))
        return &vtu->connectivity[section];
    if (section < SBI_VTU_LISTS && sbi_word_equals(name, "offsets"))
        return &vtu->offsets[section];
    if (section == SBI_VTU_CELLS && sbi_word_equals(name, "types"))
        return &vtu->types;
    return NULL;
}

/* A field of the cells that becomes the regions; in later pieces that of the first one. */
static int sbi_vtu_is_region(sbi_vtu *vtu, const sbi_vtu_array *array)
{
    sbi_loader *loader = vtu->loader;
    if (loader->pieces == 0)
        return sbi_loader_choose_regions(loader, array->name, array->class_ && array->components == 1);
    return loader->region_rank > 0 && array->class_ && array->components == 1 &&
           sbi_word_equals(array->name, loader->region_field);
}

/* The first array of one number per point becomes the labels, else the first one of the cells. */
static void sbi_vtu_note_labels(sbi_vtu *vtu, const sbi_vtu_array *array)
{
    int in_cells = vtu->section == SBI_VTU_CELL_DATA, wanted = in_cells || vtu->section == SBI_VTU_POINT_DATA;
    if (!wanted || !array->class_ || array->components != 1 ||
        (vtu->regions.present && (in_cells || !vtu->labels_in_cells)))
        return;
    vtu->regions = *array;
    vtu->labels_in_cells = in_cells;
}

static sb_result sbi_vtu_data_array(sbi_vtu *vtu)
{
    sbi_vtu_array array, *kept;
    sb_result result = sbi_vtu_array_tag(vtu, &array);
    if (result)
        return result;
    kept = vtu->image ? NULL : sbi_vtu_find_array(vtu, array.name);
    if (vtu->image)
        sbi_vtu_note_labels(vtu, &array);
    else if (kept)
        *kept = array;
    else if (vtu->section == SBI_VTU_CELL_DATA && sbi_vtu_is_region(vtu, &array))
        vtu->regions = array;
    else if (vtu->section == SBI_VTU_POINT_DATA && vtu->loader->pieces == 0)
        sbi_loader_ignore(vtu->loader, array.name);
    return SB_OK;
}

static sb_result sbi_vtu_start(sbi_vtu *vtu)
{
    static const char sections[SBI_VTU_ELSEWHERE][10] = {"Cells",  "Verts",  "Lines",     "Polys",
                                                         "Strips", "Points", "PointData", "CellData"};
    sbi_word name = vtu->xml.name;
    char text[32];
    if (!vtu->has_file && !sbi_word_equals(name, "VTKFile"))
        return sbi_reader_fail(&vtu->loader->reader, SB_ERROR_UNSUPPORTED,
                               "an XML file that begins with <%s>: only VTK's, <VTKFile>, are read",
                               sbi_word_print(name, text));
    if (sbi_word_equals(name, "VTKFile"))
        return vtu->has_file ? sbi_reader_fail(&vtu->loader->reader, SB_ERROR_FORMAT, "a second <VTKFile>")
                             : sbi_vtu_file_tag(vtu);
    if (sbi_word_equals(name, vtu->image ? "ImageData" : vtu->polydata ? "PolyData" : "UnstructuredGrid")) {
        if (vtu->image && vtu->has_grid)
            return sbi_reader_fail(&vtu->loader->reader, SB_ERROR_FORMAT, "a second <ImageData>");
        vtu->has_grid = 1;
        if (vtu->image)
            return sbi_vtu_image_tag(vtu);
    }
    if (sbi_word_equals(name, "Piece"))
        return sbi_vtu_piece_tag(vtu);
    for (int i = 0; i < SBI_VTU_ELSEWHERE && vtu->in_piece; i++)
        if (sbi_word_equals(name, sections[i]))
            vtu->section = i;
    if (sbi_word_equals(name, "DataArray") && vtu->in_piece && vtu->section != SBI_VTU_ELSEWHERE)
        return sbi_vtu_data_array(vtu);
    return SB_OK;
}

static sb_result sbi_vtu_stop(sbi_vtu *vtu)
{
    sbi_word name = vtu->xml.name;
    if (sbi_word_equals(name, "Piece") && vtu->in_piece)
        return vtu->image ? sbi_vtu_read_image(vtu) : sbi_vtu_read_piece(vtu);
    if (!sbi_word_equals(name, "DataArray") && !sbi_word_equals(name, "InformationKey"))
        vtu->section = SBI_VTU_ELSEWHERE;
    return SB_OK;
}

/* Finds the appended data, to which arrays before it refer: bytes that are no XML. */
static sb_result sbi_vtu_find_appended(sbi_vtu *vtu)
{
    static const char tag[] = "<AppendedData";
    const size_t length = sizeof tag - 1;
    sbi_reader ahead = vtu->loader->reader;
    sbi_xml xml;
    sbi_word word;
    sb_result result;
    while (sbi_reader_left(&ahead) > length && memcmp(ahead.data + ahead.at, tag, length) != 0) {
        const char *next = (const char *)memchr(ahead.data + ahead.at + 1, '<', sbi_reader_left(&ahead) - 1);
        ahead.at = next ? (size_t)(next - ahead.data) : ahead.size;
    }
    if (sbi_reader_left(&ahead) <= length)
        return SB_OK;
    memset(&xml, 0, sizeof xml);
    ahead.line = 0;
    xml.reader = &ahead;
    result = sbi_xml_next(&xml);
    if (result)
        return result;
    vtu->appended_format = SBI_VTU_RAW;
    if (sbi_xml_attribute(&xml, "encoding", &word) && sbi_word_is(word, "base64"))
        vtu->appended_format = SBI_VTU_BASE64;
    while (ahead.at < ahead.size && strchr(" \t\r\n", ahead.data[ahead.at]) && ahead.data[ahead.at])
        ahead.at++;
    if (ahead.at >= ahead.size || ahead.data[ahead.at] != '_')
        return sbi_reader_fail(&ahead, SB_ERROR_FORMAT, "<AppendedData> does not begin with \"_\"");
    vtu->appended = ahead.at + 1;
    return SB_OK;
}

SBI_API sb_result sbi_vtu_read(sbi_loader *loader)
{
    sbi_vtu vtu;
    sb_result result;
    int more = 1;
    memset(&vtu, 0, sizeof vtu);
    vtu.loader = loader;
    vtu.xml.reader = &loader->reader;
    vtu.section = SBI_VTU_ELSEWHERE;
    result = sbi_vtu_find_appended(&vtu);
    while (!result && more) {
        result = sbi_xml_next(&vtu.xml);
        if (!result && vtu.xml.event == SBI_XML_START)
            result = sbi_vtu_start(&vtu);
        else if (!result && vtu.xml.event == SBI_XML_STOP)
            result = sbi_vtu_stop(&vtu);
        else
            more = 0;
        if (vtu.xml.event == SBI_XML_START && sbi_word_equals(vtu.xml.name, "AppendedData"))
            more = 0;
    }
    if (!result && (!vtu.has_grid || vtu.in_piece))
        return sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "the file ends without %s",
                               vtu.has_grid ? "</Piece>" : "a data set");
    return result;
}
