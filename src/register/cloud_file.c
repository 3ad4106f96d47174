/* cloud_file: reading and writing clouds, on the readers of meshes. Part of the room cloud. */
#include "cloud.h"

#include "../softbody/mesh/meshio_reader.h"

#include <limits.h>

/* ==== text ======================================================================================================== */

/* A text of points that is being read. */
typedef struct regi_xyz {
    sbi_loader *loader;
    char decimal;                /* the mark that fractions between semicolons have: '.', ',' or 0, not known yet */
    int declared, declared_line; /* the number of points that the first line gives; -1: it gives none */
} regi_xyz;

/* 1 when the line has a semicolon: then commas are decimal marks. */
static int regi_xyz_has_semicolon(const sbi_reader *reader)
{
    for (size_t at = reader->at; at < reader->size && !strchr("\n\r#", reader->data[at]); at++)
        if (reader->data[at] == ';')
            return 1;
    return 0;
}

/* The next field of the line, which may be empty between two separators; 0 at the end. *separator: what is before it:
 * 0 on the first call of a line, else a semicolon, a comma or, for nothing but blanks, a blank. */
static int regi_xyz_field(sbi_reader *reader, int semicolons, sbi_word *field, char *separator)
{
    const char *marks = semicolons ? ";" : ",";
    int is_first = *separator == 0;
    if (sbi_reader_at_line_end(reader))
        return 0;
    if (!is_first) {
        *separator = reader->data[reader->at] == marks[0] ? marks[0] : ' ';
        reader->at += *separator == marks[0];
        if (sbi_reader_at_line_end(reader))
            return 0;
    } else {
        *separator = ' ';
    }
    field->text = reader->data + reader->at;
    if (sbi_reader_left(reader) > 1 && memcmp(field->text, "//", 2) == 0)
        return 0;
    while (reader->at < reader->size && !strchr(" \t\v\f\r\n#", reader->data[reader->at]) &&
           reader->data[reader->at] != marks[0])
        reader->at++;
    field->length = (size_t)(reader->data + reader->at - field->text);
    return 1;
}

/* Whether a field is meant as a number. */
static int regi_xyz_like_number(sbi_word field)
{
    double value;
    size_t i = 0;
    while (i < field.length && i < 2 && strchr("+-.,", field.text[i]))
        i++;
    return (i < field.length && field.text[i] >= '0' && field.text[i] <= '9') ||
           sbi_parse_real(field.text, field.length, &value) != 0;
}

/* As sbi_parse_real, with a decimal comma between semicolons; -2: both marks in one file. */
static int regi_xyz_number(regi_xyz *xyz, sbi_word field, int semicolons, double *value)
{
    char text[64];
    const char *comma = (const char *)memchr(field.text, ',', field.length);
    int parsed;
    if (!comma || field.length >= sizeof text) {
        parsed = sbi_parse_real(field.text, field.length, value);
    } else {
        memcpy(text, field.text, field.length);
        text[comma - field.text] = '.';
        parsed = sbi_parse_real(text, field.length, value);
    }
    if (parsed > 0 && semicolons && (comma || memchr(field.text, '.', field.length))) {
        char mark = comma ? ',' : '.';
        if (xyz->decimal && xyz->decimal != mark)
            return -2;
        xyz->decimal = mark;
    }
    return parsed;
}

static sb_result regi_xyz_fail_field(const sbi_reader *reader, sbi_word field, int parsed)
{
    char text[32];
    if (parsed == -2)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s': decimal points and decimal commas in one file",
                               sbi_word_print(field, text));
    if (parsed < 0)
        return sbi_reader_fail(reader, SB_ERROR_NOT_FINITE, "'%s' is not finite", sbi_word_print(field, text));
    if (field.length == 0)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "nothing between two separators where a number should be");
    return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s' is not a number", sbi_word_print(field, text));
}

/* `0,05,1,5`, `0,5 0,25 1,5`: columns, or decimal commas? Nobody can know. */
static int regi_xyz_is_ambiguous(sbi_word field, char separator, char first_separator)
{
    size_t sign = field.length > 0 && (field.text[0] == '-' || field.text[0] == '+') ? 1 : 0;
    if (separator != first_separator)
        return 1;
    return separator == ',' && field.length > sign + 1 && field.text[sign] == '0' && field.text[sign + 1] >= '0' &&
           field.text[sign + 1] <= '9';
}

/* The first up to six numbers of the line; a field behind the third that is none ends them. */
static sb_result regi_xyz_line(regi_xyz *xyz, double x[6], int *count)
{
    sbi_reader *reader = &xyz->loader->reader;
    int semicolons = regi_xyz_has_semicolon(reader);
    char separator = 0, first_separator = 0;
    sbi_word field;
    *count = 0;
    while (*count < 6 && regi_xyz_field(reader, semicolons, &field, &separator)) {
        int parsed = regi_xyz_number(xyz, field, semicolons, x + *count);
        if (parsed == 0 && *count >= 3)
            break;
        if (parsed <= 0)
            return regi_xyz_fail_field(reader, field, parsed);
        if (*count == 1)
            first_separator = separator;
        if (*count >= 1 && regi_xyz_is_ambiguous(field, separator, first_separator))
            return sbi_reader_fail(reader, SB_ERROR_FORMAT,
                                   "are the commas between columns, or in numbers? Write decimal points, or semicolons "
                                   "between the columns");
        ++*count;
    }
    return SB_OK;
}

/* Columns four to six are a normal when that of the first point has about unit length: colours have not. */
static int regi_xyz_has_normals(const double x[6], int count)
{
    double squared = x[3] * x[3] + x[4] * x[4] + x[5] * x[5];
    return count == 6 && squared > 0.25 && squared < 4;
}

/* 1 for a first line that is a heading, or holds nothing but the number of points, which is noted. */
static int regi_xyz_is_heading(regi_xyz *xyz)
{
    sbi_reader ahead = xyz->loader->reader;
    int semicolons = regi_xyz_has_semicolon(&ahead), fields = 0, numbers = 0;
    char separator = 0;
    sbi_word field, first = {NULL, 0};
    int64_t declared;
    while (regi_xyz_field(&ahead, semicolons, &field, &separator)) {
        if (fields++ == 0)
            first = field;
        numbers += regi_xyz_like_number(field);
    }
    if (numbers == 0)
        return 1;
    if (fields != 1 || sbi_parse_integer(first.text, first.length, &declared) <= 0 || declared < 0 ||
        declared > INT_MAX)
        return 0;
    xyz->declared = (int)declared;
    xyz->declared_line = xyz->loader->reader.line;
    return 1;
}

static int regi_xyz_is_empty(const sbi_reader *reader)
{
    sbi_reader ahead = *reader;
    char separator = 0;
    sbi_word field;
    return !regi_xyz_field(&ahead, regi_xyz_has_semicolon(reader), &field, &separator);
}

/* A point, and its normal where the first one has one. */
static sb_result regi_xyz_point(regi_xyz *xyz, int *with_normals)
{
    sbi_loader *loader = xyz->loader;
    int count;
    double x[6];
    sb_result result = regi_xyz_line(xyz, x, &count);
    if (!result && count < 3)
        result = sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "a point needs three numbers, here are %d", count);
    if (!result && loader->node_count == 0)
        *with_normals = regi_xyz_has_normals(x, count);
    if (!result && *with_normals && count < 6)
        result = sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "a point without the normal that the first one has");
    if (!result)
        result = sbi_loader_add_node(loader, x);
    if (!result && *with_normals)
        result = sbi_loader_add_normal(loader, x + 3);
    return result;
}

static sb_result regi_xyz_read(sbi_loader *loader)
{
    sbi_reader *reader = &loader->reader;
    sb_result result = sbi_reader_check_kind(reader);
    int with_normals = 0, is_first = 1;
    regi_xyz xyz;
    xyz.loader = loader;
    xyz.decimal = 0;
    xyz.declared = -1;
    xyz.declared_line = 0;
    reader->comment = '#';
    if (!result)
        result = sbi_reader_check_text(reader);
    for (; reader->at < reader->size && !result; sbi_reader_next_line(reader)) {
        if (regi_xyz_is_empty(reader))
            continue;
        reader->node = (int)loader->node_count;
        if (!is_first || !regi_xyz_is_heading(&xyz))
            result = regi_xyz_point(&xyz, &with_normals);
        is_first = 0;
    }
    reader->node = -1;
    if (!result && xyz.declared >= 0 && (size_t)xyz.declared != loader->node_count) {
        reader->line = xyz.declared_line;
        result = sbi_reader_fail(reader, SB_ERROR_FORMAT, "the first line says %d points, there are %lu", xyz.declared,
                                 (unsigned long)loader->node_count);
    }
    return result;
}

/* ==== loading ===================================================================================================== */

/* Endings that only texts of points have. */
static int regi_cloud_named_text(const char *name)
{
    static const char endings[6][6] = {".xyz", ".txt", ".csv", ".asc", ".pts", ".xyzn"};
    size_t length = strlen(name);
    for (int i = 0; i < 6; i++) {
        sbi_word word;
        word.length = strlen(endings[i]);
        word.text = name + length - word.length;
        if (length >= word.length && sbi_word_is(word, endings[i]))
            return 1;
    }
    return 0;
}

/* A text of points has no mark: it is what no mesh format claims. */
static sb_result regi_cloud_parse(sbi_loader *loader, reg_cloud_format format)
{
    sb_file_format mesh = format == REG_CLOUD_PLY ? SB_FILE_PLY : SB_FILE_AUTO;
    sbi_reader quiet = loader->reader;
    sbi_word word;
    quiet.error = NULL;
    if (loader->reader.size == 0)
        return sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "the file is empty");
    if (format == REG_CLOUD_AUTO && sbi_reader_peek(&quiet, &word) && sbi_word_is(word, "ply"))
        mesh = SB_FILE_PLY;
    else if (format == REG_CLOUD_AUTO && regi_cloud_named_text(loader->reader.name))
        format = REG_CLOUD_XYZ;
    else if (format == REG_CLOUD_AUTO && sbi_file_detect(&quiet, &mesh) == SB_ERROR_FORMAT)
        format = REG_CLOUD_XYZ;
    if (format == REG_CLOUD_XYZ)
        return regi_xyz_read(loader);
    if (mesh == SB_FILE_AUTO) {
        sb_result result = sbi_file_detect(&loader->reader, &mesh);
        if (result != SB_OK)
            return result;
    }
    return sbi_loader_parse(loader, mesh);
}

static sb_result regi_cloud_read(sbi_loader *loader, reg_cloud_format format, reg_cloud *cloud)
{
    sb_result result;
    loader->points_only = 1;
    result = regi_cloud_parse(loader, format);
    if (!result && loader->node_count == 0)
        result = sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "the file has no points");
    if (result)
        return result;
    memset(cloud, 0, sizeof *cloud);
    cloud->allocator = loader->allocator;
    cloud->count = (int)loader->node_count;
    cloud->points = loader->nodes;
    loader->nodes = NULL;
    if (loader->normal_count == loader->node_count) {
        cloud->normals = loader->normals;
        loader->normals = NULL;
        for (int i = 0; i < cloud->count; i++)
            cloud->normals[i] = regi_cloud_unit(cloud->normals[i]);
    }
    return SB_OK;
}

static sb_result regi_cloud_begin(sbi_loader *loader, const void *cloud, sb_real scale, const sb_allocator *allocator,
                                  sb_error *error)
{
    sb_load_options options = sb_default_load_options();
    if (!cloud)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "cloud is NULL");
    if (!(scale > 0) || !sb_is_finite(scale))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the scale is %g, it must be positive", (double)scale);
    options.scale = scale;
    if (allocator)
        options.allocator = *allocator;
    sbi_loader_init(loader, &options, error);
    return SB_OK;
}

REG_API sb_result reg_cloud_load_memory(reg_cloud *cloud, const void *data, size_t size, reg_cloud_format format,
                                        const char *name, sb_real scale, const sb_allocator *allocator, sb_error *error)
{
    sbi_loader loader;
    sb_result result = regi_cloud_begin(&loader, cloud, scale, allocator, error);
    if (result)
        return result;
    if (!data && size)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "data is NULL");
    if ((int)format < REG_CLOUD_AUTO || (int)format > REG_CLOUD_MESH)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d is not a format of clouds", (int)format);
    sbi_loader_set_content(&loader, size ? (const char *)data : "", size, name);
    result = regi_cloud_read(&loader, format, cloud);
    sbi_loader_free(&loader);
    return result;
}

REG_API sb_result reg_cloud_load(reg_cloud *cloud, const char *path, sb_real scale, const sb_allocator *allocator,
                                 sb_error *error)
{
    sbi_loader loader;
    sbi_file content;
    sb_result result = regi_cloud_begin(&loader, cloud, scale, allocator, error);
    if (result)
        return result;
    if (!path)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "path is NULL");
    result = sbi_file_read(&loader.allocator, path, &content, error);
    if (!result) {
        sbi_loader_set_content(&loader, content.data, content.size, path);
        result = regi_cloud_read(&loader, REG_CLOUD_AUTO, cloud);
    }
    sbi_free(&loader.allocator, content.data);
    sbi_loader_free(&loader);
    return result;
}

/* ==== writing ===================================================================================================== */

static void regi_cloud_write_vector(sbi_export *out, sb_vec3 v, const char *after)
{
    sb_real x[3];
    x[0] = v.x, x[1] = v.y, x[2] = v.z;
    for (int i = 0; i < 3; i++) {
        if (out->binary) {
            sbi_export_bits(out, sbi_export_real_bits(x[i]), (int)sizeof(sb_real), 0);
            continue;
        }
        sbi_export_print_real(out, x[i]);
        sbi_export_text(out, i < 2 ? " " : after);
    }
}

static void regi_cloud_write_header(sbi_export *out, const reg_cloud *cloud)
{
    static const char names[6][3] = {"x", "y", "z", "nx", "ny", "nz"};
    char line[64];
    sbi_export_text(out, out->binary ? "ply\nformat binary_little_endian 1.0\n" : "ply\nformat ascii 1.0\n");
    snprintf(line, sizeof line, "comment unit: metre\nelement vertex %d\n", cloud->count);
    sbi_export_text(out, line);
    for (int i = 0; i < (cloud->normals ? 6 : 3); i++) {
        snprintf(line, sizeof line, "property %s %s\n", SB_REAL_IS_FLOAT ? "float" : "double", names[i]);
        sbi_export_text(out, line);
    }
    sbi_export_text(out, "end_header\n");
}

REG_API sb_result reg_cloud_save_ply(const char *path, const reg_cloud *cloud, int ascii, sb_error *error)
{
    sbi_export out;
    sb_result result;
    if (!path || !cloud)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", path ? "cloud" : "path");
    result = regi_cloud_check(cloud->points, cloud->normals, cloud->count, error);
    if (!result)
        result = sbi_export_open(&out, path, !ascii, error);
    if (result)
        return result;
    regi_cloud_write_header(&out, cloud);
    for (int i = 0; i < cloud->count; i++) {
        regi_cloud_write_vector(&out, cloud->points[i], cloud->normals ? " " : "\n");
        if (cloud->normals)
            regi_cloud_write_vector(&out, cloud->normals[i], "\n");
    }
    return sbi_export_close(&out, error);
}
