/* cloud_file: reading and writing clouds, on the readers of meshes. Part of the room cloud. */
#include "cloud.h"

#include "../softbody/meshio_reader.h"

/* ==== text ======================================================================================================== */

/* The next number or word between blanks, commas and semicolons; 0 at the end of the line. */
static int regi_xyz_word(sbi_reader *reader, sbi_word *word)
{
    size_t start;
    while (!sbi_reader_at_line_end(reader) && (reader->data[reader->at] == ',' || reader->data[reader->at] == ';'))
        reader->at++;
    if (sbi_reader_at_line_end(reader))
        return 0;
    start = reader->at;
    if (sbi_reader_left(reader) > 1 && memcmp(reader->data + start, "//", 2) == 0)
        return 0;
    while (reader->at < reader->size && !strchr(" \t\v\f\r\n,;#", reader->data[reader->at]))
        reader->at++;
    if (reader->at == start) /* a NUL, which strchr finds as well: the word is that */
        reader->at++;
    word->text = reader->data + start;
    word->length = reader->at - start;
    return 1;
}

/* The first up to six numbers of the line; a word behind the third that is none ends them. *first: what the first word
 * was, 1 a number, 0 none, -1 not finite. */
static sb_result regi_xyz_line(sbi_reader *reader, double x[6], int *count, int *first)
{
    sbi_word word;
    char text[32];
    *count = 0;
    *first = 0;
    while (*count < 6 && regi_xyz_word(reader, &word)) {
        int parsed = sbi_parse_real(word.text, word.length, x + *count);
        if (*count == 0)
            *first = parsed;
        if (parsed < 0)
            return sbi_reader_fail(reader, SB_ERROR_NOT_FINITE, "'%s' is not finite", sbi_word_print(word, text));
        if (parsed == 0 && *count >= 3)
            break;
        if (parsed == 0)
            return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s' is not a number", sbi_word_print(word, text));
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

/* 1 for a first line that is a heading, or holds nothing but the number of points. */
static int regi_xyz_is_heading(const sbi_reader *reader)
{
    sbi_reader quiet = *reader;
    double x[6];
    int count, first;
    quiet.error = NULL;
    regi_xyz_line(&quiet, x, &count, &first);
    return first == 0 || (first > 0 && count == 1);
}

static sb_result regi_xyz_read(sbi_loader *loader)
{
    sbi_reader *reader = &loader->reader;
    int with_normals = 0, headings = 1, count, first;
    sb_result result = SB_OK;
    double x[6];
    reader->comment = '#';
    for (; reader->at < reader->size && !result; sbi_reader_next_line(reader)) {
        sbi_reader ahead = *reader;
        sbi_word word;
        if (!regi_xyz_word(&ahead, &word))
            continue;
        reader->node = (int)loader->node_count;
        if (headings-- > 0 && regi_xyz_is_heading(reader))
            continue;
        headings = 0;
        result = regi_xyz_line(reader, x, &count, &first);
        if (!result && count < 3)
            result = sbi_reader_fail(reader, SB_ERROR_FORMAT, "a point needs three numbers, here are %d", count);
        if (!result && loader->node_count == 0)
            with_normals = regi_xyz_has_normals(x, count);
        if (!result && with_normals && count < 6)
            result = sbi_reader_fail(reader, SB_ERROR_FORMAT, "a point without the normal that the first one has");
        if (!result)
            result = sbi_loader_add_node(loader, x);
        if (!result && with_normals)
            result = sbi_loader_add_normal(loader, x + 3);
    }
    reader->node = -1;
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
                                        const char *name, sb_real scale, const sb_allocator *allocator,
                                        sb_error *error)
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
