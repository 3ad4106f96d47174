/* image_files: the headers of MetaImage and NRRD. Sources: "MetaIO" (itk.org/Wiki/MetaIO/Documentation), "Definition of
 * NRRD File Format" (teem.sourceforge.net/nrrd/format.html). */
#include "meshio_reader.h"

#include <limits.h>
#include <string.h>

/* A line of a header: what stands before and behind its sign. */
typedef struct sbi_header_line {
    sbi_word key;
    sbi_word rest;
    sbi_reader value; /* of `rest` only */
} sbi_header_line;

static int sbi_header_blank(char c) { return c == ' ' || c == '\t' || c == '\r'; }

static sbi_word sbi_header_trim(const char *begin, const char *end)
{
    sbi_word word;
    while (begin < end && sbi_header_blank(*begin))
        begin++;
    while (end > begin && sbi_header_blank(end[-1]))
        end--;
    word.text = begin;
    word.length = (size_t)(end - begin);
    return word;
}

/* The next line, cut at the first `sign`; the reader stands at the line after it. 0: the line has no such sign. */
static int sbi_header_next(sbi_reader *reader, char sign, sbi_header_line *line)
{
    const char *begin = reader->data + reader->at;
    const char *end = (const char *)memchr(begin, '\n', sbi_reader_left(reader));
    const char *cut;
    if (!end)
        end = reader->data + reader->size;
    cut = (const char *)memchr(begin, sign, (size_t)(end - begin));
    line->key = sbi_header_trim(begin, cut ? cut : end);
    line->rest = cut ? sbi_header_trim(cut + 1, end) : sbi_header_trim(end, end);
    line->value = *reader;
    line->value.data = line->rest.text;
    line->value.size = line->rest.length;
    line->value.at = 0;
    reader->at = (size_t)(end - reader->data);
    if (reader->at < reader->size) {
        reader->at++;
        if (reader->line < INT_MAX)
            reader->line++;
    }
    return cut != NULL;
}

static sb_result sbi_header_integer(sbi_header_line *line, const char *what, int *value)
{
    return sbi_reader_count(&line->value, what, 0, value);
}

static sb_result sbi_header_counts(sbi_header_line *line, int dimension, int points[3])
{
    sb_result result = SB_OK;
    points[2] = 1;
    for (int k = 0; k < dimension && !result; k++) {
        result = sbi_header_integer(line, "the number of voxels", &points[k]);
        if (!result && points[k] < 1)
            return sbi_reader_fail(&line->value, SB_ERROR_FORMAT, "0 voxels along an axis");
    }
    return result;
}

static sb_result sbi_header_dimension(sbi_header_line *line, int *dimension)
{
    sb_result result = sbi_header_integer(line, "the dimension", dimension);
    if (!result && *dimension != 2 && *dimension != 3)
        return sbi_reader_fail(&line->value, SB_ERROR_UNSUPPORTED,
                               "an image of %d dimensions: label images have 3, or 2", *dimension);
    return result;
}

/* ---- MetaImage ---- */

typedef struct sbi_meta {
    sbi_voxels *voxels;
    sbi_voxel_data *data;
    int dimension, has_counts, has_spacing, text;
} sbi_meta;

static sb_result sbi_meta_type(const sbi_meta *meta, sbi_header_line *line)
{
    static const struct {
        char name[16];
        char class_;
        int size;
    } types[] = {{"MET_CHAR", 'i', 1},  {"MET_UCHAR", 'u', 1},  {"MET_SHORT", 'i', 2},     {"MET_USHORT", 'u', 2},
                 {"MET_INT", 'i', 4},   {"MET_UINT", 'u', 4},   {"MET_LONG", 'i', 4},      {"MET_ULONG", 'u', 4},
                 {"MET_FLOAT", 'f', 4}, {"MET_DOUBLE", 'f', 8}, {"MET_LONG_LONG", 'i', 8}, {"MET_ULONG_LONG", 'u', 8}};
    char text[32];
    for (size_t i = 0; i < sizeof types / sizeof types[0]; i++)
        if (sbi_word_is(line->rest, types[i].name)) {
            meta->data->class_ = types[i].class_;
            meta->data->size = types[i].size;
            return SB_OK;
        }
    return sbi_reader_fail(&line->value, SB_ERROR_UNSUPPORTED, "values of type %s", sbi_word_print(line->rest, text));
}

/* Rows are the axes. */
static sb_result sbi_meta_direction(const sbi_meta *meta, sbi_header_line *line)
{
    double rows[9];
    int n = meta->dimension;
    sb_result result = sbi_voxels_read_reals(&line->value, "direction", n * n, rows);
    for (int i = 0; i < n * n && !result; i++)
        meta->voxels->direction[i / n][i % n] = rows[i];
    return result;
}

static int sbi_meta_is(const sbi_header_line *line, const char *a, const char *b, const char *c)
{
    return sbi_word_is(line->key, a) || sbi_word_is(line->key, b) || sbi_word_is(line->key, c);
}

static sb_result sbi_meta_geometry(sbi_meta *meta, sbi_header_line *line)
{
    sb_result result = SB_OK;
    if (!meta->dimension)
        return sbi_reader_fail(&line->value, SB_ERROR_FORMAT, "NDims must come before it");
    if (sbi_word_is(line->key, "DimSize")) {
        meta->has_counts = 1;
        return sbi_header_counts(line, meta->dimension, meta->voxels->points);
    }
    if (sbi_meta_is(line, "Offset", "Position", "Origin"))
        return sbi_voxels_read_reals(&line->value, "origin", meta->dimension, meta->voxels->origin);
    if (sbi_meta_is(line, "TransformMatrix", "Rotation", "Orientation"))
        return sbi_meta_direction(meta, line);
    if (sbi_word_is(line->key, "ElementSize") && meta->has_spacing)
        return SB_OK;
    meta->has_spacing |= sbi_word_is(line->key, "ElementSpacing");
    result = sbi_voxels_read_reals(&line->value, "spacing", meta->dimension, meta->voxels->spacing);
    return result ? result : sbi_voxels_check_spacing(&line->value, meta->voxels->spacing);
}

static int sbi_meta_is_true(const sbi_header_line *line)
{
    return line->rest.length > 0 &&
           (line->rest.text[0] == 'T' || line->rest.text[0] == 't' || line->rest.text[0] == '1');
}

/* A line other than ElementDataFile. */
static sb_result sbi_meta_line(sbi_meta *meta, sbi_header_line *line)
{
    int number = 0;
    sb_result result;
    if (sbi_word_is(line->key, "NDims"))
        return sbi_header_dimension(line, &meta->dimension);
    if (sbi_meta_is(line, "DimSize", "ElementSpacing", "ElementSize") ||
        sbi_meta_is(line, "Offset", "Position", "Origin") ||
        sbi_meta_is(line, "TransformMatrix", "Rotation", "Orientation"))
        return sbi_meta_geometry(meta, line);
    if (sbi_word_is(line->key, "ElementType"))
        return sbi_meta_type(meta, line);
    if (sbi_word_is(line->key, "BinaryDataByteOrderMSB") || sbi_word_is(line->key, "ElementByteOrderMSB"))
        meta->data->big_endian = sbi_meta_is_true(line);
    if (sbi_word_is(line->key, "BinaryData"))
        meta->text = !sbi_meta_is_true(line);
    if (sbi_word_is(line->key, "CompressedData") && sbi_meta_is_true(line))
        meta->data->encoding = SBI_VOXELS_ZLIB;
    if (sbi_word_is(line->key, "ObjectType") && !sbi_word_is(line->rest, "Image"))
        return sbi_reader_fail(&line->value, SB_ERROR_UNSUPPORTED, "a MetaIO object that is no image");
    if (sbi_word_is(line->key, "HeaderSize") && !sbi_word_is(line->rest, "0"))
        return sbi_reader_fail(&line->value, SB_ERROR_UNSUPPORTED, "a data file that has a header of its own");
    if (!sbi_word_is(line->key, "ElementNumberOfChannels"))
        return SB_OK;
    result = sbi_header_integer(line, "the number of channels", &number);
    if (!result && number != 1)
        return sbi_reader_fail(&line->value, SB_ERROR_UNSUPPORTED, "%d values per voxel: labels have one", number);
    return result;
}

SBI_API sb_result sbi_meta_read(sbi_loader *loader, sbi_voxel_data *data)
{
    sbi_reader *reader = &loader->reader;
    sbi_header_line line;
    sbi_meta meta;
    sb_result result = SB_OK;
    memset(&meta, 0, sizeof meta);
    meta.voxels = loader->voxels;
    meta.data = data;
    for (;;) {
        if (!sbi_reader_left(reader))
            return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends without ElementDataFile");
        if (!sbi_header_next(reader, '=', &line) && line.key.length)
            return sbi_reader_fail(&line.value, SB_ERROR_FORMAT, "a line of the header without \"=\"");
        if (sbi_word_is(line.key, "ElementDataFile"))
            break;
        result = line.key.length ? sbi_meta_line(&meta, &line) : SB_OK;
        if (result)
            return result;
    }
    if (!meta.has_counts || !data->class_)
        return sbi_reader_fail(&line.value, SB_ERROR_FORMAT, "the header has no %s",
                               meta.has_counts ? "ElementType" : "DimSize");
    if (meta.text)
        data->encoding = SBI_VOXELS_TEXT;
    data->has_file = !sbi_word_is(line.rest, "LOCAL");
    data->file = line.rest;
    if (sbi_word_is(line.rest, "LIST") || memchr(line.rest.text, '%', line.rest.length))
        return sbi_reader_fail(&line.value, SB_ERROR_UNSUPPORTED, "voxels in several files");
    return SB_OK;
}

/* ---- NRRD ---- */

typedef struct sbi_nrrd {
    sbi_voxels *voxels;
    sbi_voxel_data *data;
    int dimension, has_counts, has_encoding, has_endian;
} sbi_nrrd;

static sb_result sbi_nrrd_type(const sbi_nrrd *nrrd, const sbi_header_line *line)
{
    static const struct {
        char names[5][24];
        char class_;
        int size;
    } types[] = {{{"signed char", "int8", "int8_t", "", ""}, 'i', 1},
                 {{"uchar", "unsigned char", "uint8", "uint8_t", ""}, 'u', 1},
                 {{"short", "short int", "signed short", "int16", "int16_t"}, 'i', 2},
                 {{"ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"}, 'u', 2},
                 {{"int", "signed int", "int32", "int32_t", ""}, 'i', 4},
                 {{"uint", "unsigned int", "uint32", "uint32_t", ""}, 'u', 4},
                 {{"longlong", "long long", "long long int", "int64", "int64_t"}, 'i', 8},
                 {{"ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t"}, 'u', 8},
                 {{"float", "", "", "", ""}, 'f', 4},
                 {{"double", "", "", "", ""}, 'f', 8}};
    char text[32];
    for (size_t i = 0; i < sizeof types / sizeof types[0]; i++)
        for (int k = 0; k < 5 && types[i].names[k][0]; k++)
            if (sbi_word_is(line->rest, types[i].names[k])) {
                nrrd->data->class_ = types[i].class_;
                nrrd->data->size = types[i].size;
                return SB_OK;
            }
    return sbi_reader_fail(&line->value, SB_ERROR_UNSUPPORTED, "values of type %s", sbi_word_print(line->rest, text));
}

static sb_result sbi_nrrd_encoding(sbi_nrrd *nrrd, const sbi_header_line *line)
{
    static const struct {
        char name[8];
        sbi_voxel_encoding encoding;
    } known[] = {{"raw", SBI_VOXELS_RAW},    {"txt", SBI_VOXELS_TEXT}, {"text", SBI_VOXELS_TEXT},
                 {"ascii", SBI_VOXELS_TEXT}, {"gz", SBI_VOXELS_GZIP},  {"gzip", SBI_VOXELS_GZIP}};
    char text[32];
    nrrd->has_encoding = 1;
    for (size_t i = 0; i < sizeof known / sizeof known[0]; i++)
        if (sbi_word_is(line->rest, known[i].name)) {
            nrrd->data->encoding = known[i].encoding;
            return SB_OK;
        }
    return sbi_reader_fail(&line->value, SB_ERROR_UNSUPPORTED, "encoding %s: raw, text and gzip are read",
                           sbi_word_print(line->rest, text));
}

/* "(x,y,z)", blanks allowed: one vector. */
static sb_result sbi_nrrd_vector(sbi_reader *value, double v[3])
{
    int at = 0;
    while (value->at < value->size && sbi_header_blank(value->data[value->at]))
        value->at++;
    if (value->at >= value->size || value->data[value->at] != '(')
        return sbi_reader_fail(value, SB_ERROR_UNSUPPORTED, "a vector like (1,0,0) is missing");
    value->at++;
    for (;;) {
        size_t end = value->at;
        sbi_word word;
        int parsed;
        while (end < value->size && value->data[end] != ',' && value->data[end] != ')')
            end++;
        word = sbi_header_trim(value->data + value->at, value->data + end);
        if (end >= value->size || at == 3)
            return sbi_reader_fail(value, SB_ERROR_UNSUPPORTED, "a vector that has not three numbers");
        parsed = sbi_parse_real(word.text, word.length, &v[at++]);
        if (parsed <= 0)
            return sbi_reader_fail(value, parsed ? SB_ERROR_NOT_FINITE : SB_ERROR_FORMAT, "a vector with what is %s",
                                   parsed ? "not finite" : "no number");
        value->at = end + 1;
        if (value->data[end] == ')')
            break;
    }
    return at == 3 ? SB_OK
                   : sbi_reader_fail(value, SB_ERROR_UNSUPPORTED, "a vector of %d numbers: label images need 3", at);
}

static sb_result sbi_nrrd_directions(const sbi_nrrd *nrrd, sbi_header_line *line)
{
    double v[3][3];
    sb_result result = SB_OK;
    if (nrrd->dimension != 3)
        return sbi_reader_fail(&line->value, SB_ERROR_UNSUPPORTED,
                               "space directions of an image that has not three axes");
    for (int axis = 0; axis < 3 && !result; axis++)
        result = sbi_nrrd_vector(&line->value, v[axis]);
    for (int axis = 0; axis < 3 && !result; axis++) { /* their lengths are the spacing */
        nrrd->voxels->spacing[axis] = 1;
        memcpy(nrrd->voxels->direction[axis], v[axis], sizeof v[axis]);
    }
    return result;
}

static sb_result sbi_nrrd_geometry(sbi_nrrd *nrrd, sbi_header_line *line)
{
    sb_result result;
    if (sbi_word_is(line->key, "space origin"))
        return sbi_nrrd_vector(&line->value, nrrd->voxels->origin);
    if (!nrrd->dimension)
        return sbi_reader_fail(&line->value, SB_ERROR_FORMAT, "the dimension must come before it");
    if (sbi_word_is(line->key, "space directions"))
        return sbi_nrrd_directions(nrrd, line);
    if (sbi_word_is(line->key, "sizes")) {
        nrrd->has_counts = 1;
        return sbi_header_counts(line, nrrd->dimension, nrrd->voxels->points);
    }
    result = sbi_voxels_read_reals(&line->value, "spacing", nrrd->dimension, nrrd->voxels->spacing);
    return result ? result : sbi_voxels_check_spacing(&line->value, nrrd->voxels->spacing);
}

static sb_result sbi_nrrd_line(sbi_nrrd *nrrd, sbi_header_line *line)
{
    static const char geometry[4][20] = {"space origin", "space directions", "sizes", "spacings"};
    if (sbi_word_is(line->key, "dimension"))
        return sbi_header_dimension(line, &nrrd->dimension);
    for (int i = 0; i < 4; i++)
        if (sbi_word_is(line->key, geometry[i]))
            return sbi_nrrd_geometry(nrrd, line);
    if (sbi_word_is(line->key, "type"))
        return sbi_nrrd_type(nrrd, line);
    if (sbi_word_is(line->key, "encoding"))
        return sbi_nrrd_encoding(nrrd, line);
    if (sbi_word_is(line->key, "endian")) {
        nrrd->has_endian = 1;
        nrrd->data->big_endian = sbi_word_is(line->rest, "big");
        if (!nrrd->data->big_endian && !sbi_word_is(line->rest, "little"))
            return sbi_reader_fail(&line->value, SB_ERROR_FORMAT, "endian is neither big nor little");
    }
    if (sbi_word_is(line->key, "data file") || sbi_word_is(line->key, "datafile")) {
        nrrd->data->has_file = 1;
        nrrd->data->file = line->rest;
        if (sbi_word_is(line->rest, "LIST") || memchr(line->rest.text, '%', line->rest.length))
            return sbi_reader_fail(&line->value, SB_ERROR_UNSUPPORTED, "voxels in several files");
    }
    if ((sbi_word_is(line->key, "byte skip") || sbi_word_is(line->key, "line skip") ||
         sbi_word_is(line->key, "byteskip") || sbi_word_is(line->key, "lineskip")) &&
        !sbi_word_is(line->rest, "0"))
        return sbi_reader_fail(&line->value, SB_ERROR_UNSUPPORTED, "a data file that has a header of its own");
    return SB_OK; /* names of axes, units and the like */
}

static sb_result sbi_nrrd_finish(const sbi_nrrd *nrrd, const sbi_reader *reader)
{
    const char *missing = !nrrd->has_counts     ? "sizes"
                          : !nrrd->data->class_ ? "type"
                          : !nrrd->has_encoding ? "encoding"
                                                : NULL;
    if (!missing && !nrrd->has_endian && nrrd->data->size > 1 && nrrd->data->encoding != SBI_VOXELS_TEXT)
        missing = "endian";
    return missing ? sbi_reader_fail(reader, SB_ERROR_FORMAT, "the header has no %s", missing) : SB_OK;
}

SBI_API sb_result sbi_nrrd_read(sbi_loader *loader, sbi_voxel_data *data)
{
    sbi_reader *reader = &loader->reader;
    sbi_header_line line;
    sbi_nrrd nrrd;
    sb_result result = SB_OK;
    memset(&nrrd, 0, sizeof nrrd);
    nrrd.voxels = loader->voxels;
    nrrd.data = data;
    sbi_reader_next_line(reader); /* NRRD0004 */
    while (sbi_reader_left(reader) && !result) {
        int has_sign = sbi_header_next(reader, ':', &line);
        if (!line.key.length && !has_sign)
            return sbi_nrrd_finish(&nrrd, reader); /* the voxels begin behind the blank line */
        if (line.key.length && line.key.text[0] == '#')
            continue;
        if (!has_sign)
            return sbi_reader_fail(&line.value, SB_ERROR_FORMAT, "a line of the header without \":\"");
        if (line.rest.length == 0 || line.rest.text[0] != '=') /* "key:=value" is a remark */
            result = sbi_nrrd_line(&nrrd, &line);
    }
    if (!result && !data->has_file)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends in its header");
    return result ? result : sbi_nrrd_finish(&nrrd, reader);
}
