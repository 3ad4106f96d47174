/* meshio: loading (file, format, checks, report) and the writers. */
#include "meshio.h"

#include <float.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "meshio_reader.h"

/* ==== options ====================================================================================== */

enum { SBI_LOAD_COOKIE = 0x6d657368 };

SB_API sb_load_options sb_default_load_options(void)
{
    sb_load_options options;
    memset(&options, 0, sizeof options);
    options.scale = 1;
    options.cookie = SBI_LOAD_COOKIE;
    return options;
}

SBI_API sb_result sbi_load_options_resolve(const sb_load_options *options, sb_load_options *resolved, sb_error *error)
{
    *resolved = options ? *options : sb_default_load_options();
    if (resolved->cookie != SBI_LOAD_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the load options do not come from sb_default_load_options()");
    if (!(resolved->scale > 0) || !sb_is_finite(resolved->scale))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the scale is %g, it must be positive", (double)resolved->scale);
    return SB_OK;
}

/* ==== format ======================================================================================= */

static int sbi_meshio_starts_with(const sbi_reader *reader, const char *text)
{
    sbi_word word;
    word.text = reader->data + reader->at;
    word.length = strlen(text);
    return sbi_reader_left(reader) >= word.length && sbi_word_is(word, text);
}

static int sbi_meshio_name_ends_with(const char *name, const char *ending)
{
    size_t length = strlen(name), tail = strlen(ending);
    sbi_word word;
    if (length < tail)
        return 0;
    word.text = name + length - tail;
    word.length = tail;
    return sbi_word_is(word, ending);
}

static sb_file_format sbi_meshio_format_of_name(const char *name)
{
    static const struct {
        char ending[7];
        sb_file_format format;
    } endings[] = {{".vtk", SB_FILE_VTK}, {".msh", SB_FILE_GMSH}, {".node", SB_FILE_TETGEN}, {".ele", SB_FILE_TETGEN},
                   {".obj", SB_FILE_OBJ}, {".stl", SB_FILE_STL},  {".ply", SB_FILE_PLY},     {".off", SB_FILE_OFF},
                   {".vtu", SB_FILE_VTU}, {".vtp", SB_FILE_VTU},  {".mesh", SB_FILE_MEDIT},  {".meshb", SB_FILE_MEDIT}};
    for (size_t i = 0; i < sizeof endings / sizeof endings[0]; i++)
        if (sbi_meshio_name_ends_with(name, endings[i].ending))
            return endings[i].format;
    return SB_FILE_AUTO;
}

/* By what the file begins with; AUTO when that decides nothing. */
static sb_file_format sbi_meshio_format_of_content(const sbi_reader *reader)
{
    sbi_word word;
    /* First, since the header of a binary STL file may hold anything. A text whose bytes happen to be such
     * a count would have to be as large as that count says: more than 7 GB. */
    if (sbi_stl_is_binary(reader->data, reader->size))
        return SB_FILE_STL;
    if (sbi_meshio_starts_with(reader, "# vtk DataFile"))
        return SB_FILE_VTK;
    if (sbi_medit_is_binary(reader->data, reader->size))
        return SB_FILE_MEDIT;
    if (!sbi_reader_peek(reader, &word))
        return SB_FILE_AUTO;
    if (word.text[0] == '<')
        return SB_FILE_VTU;
    if (word.length >= 20 && memcmp(word.text, "MeshVersionFormatted", 20) == 0)
        return SB_FILE_MEDIT;
    if (word.length > 1 && word.text[0] == '$' && word.text[1] >= 'A' && word.text[1] <= 'Z')
        return SB_FILE_GMSH;
    if (sbi_word_is(word, "ply"))
        return SB_FILE_PLY;
    if (sbi_word_is(word, "solid"))
        return SB_FILE_STL;
    if (word.length >= 3 && word.length <= 8 && memcmp(word.text + word.length - 3, "OFF", 3) == 0)
        return SB_FILE_OFF;
    return SB_FILE_AUTO;
}

/* OBJ has no mark of its own: a file without a telling name whose first line is one of OBJ's. */
static int sbi_meshio_looks_like_obj(const sbi_reader *reader)
{
    static const char keywords[9][7] = {"v", "vn", "vt", "f", "o", "g", "s", "mtllib", "usemtl"};
    sbi_reader ahead = *reader;
    sbi_word word;
    ahead.comment = '#';
    if (!sbi_reader_word(&ahead, &word))
        return 0;
    for (int i = 0; i < 9; i++)
        if (sbi_word_is(word, keywords[i]))
            return 1;
    return 0;
}

SBI_API sb_result sbi_file_detect(const sbi_reader *reader, sb_file_format *format)
{
    if (reader->size == 0)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file is empty");
    if (!sbi_stl_is_binary(reader->data, reader->size)) {
        sb_result result = sbi_reader_check_kind(reader);
        if (result)
            return result;
    }
    if (*format == SB_FILE_AUTO)
        *format = sbi_meshio_format_of_content(reader);
    if (*format == SB_FILE_AUTO)
        *format = sbi_meshio_format_of_name(reader->name);
    if (*format == SB_FILE_AUTO && sbi_meshio_looks_like_obj(reader))
        *format = SB_FILE_OBJ;
    if (*format == SB_FILE_AUTO)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file is in no known format");
    return SB_OK;
}

/* ==== loading ====================================================================================== */

SBI_API sb_result sbi_loader_parse(sbi_loader *loader, sb_file_format format)
{
    switch (format) {
    case SB_FILE_VTK: return sbi_vtk_read(loader);
    case SB_FILE_GMSH: return sbi_gmsh_read(loader);
    case SB_FILE_OBJ: return sbi_obj_read(loader);
    case SB_FILE_STL: return sbi_stl_read(loader);
    case SB_FILE_PLY: return sbi_ply_read(loader);
    case SB_FILE_OFF: return sbi_off_read(loader);
    case SB_FILE_VTU: return sbi_vtu_read(loader);
    case SB_FILE_MEDIT: return sbi_medit_read(loader);
    case SB_FILE_TETGEN:
    case SB_FILE_AUTO: break;
    }
    return sbi_reader_fail(&loader->reader, SB_ERROR_ARGUMENT, "this format cannot be read from one piece of memory");
}

/* Whether every tet10 has its last two mid-edge nodes nearer to the other's edge: gmsh's order in a file that should
 * have VTK's. */
static int sbi_meshio_has_gmsh_order(const sb_mesh *mesh)
{
    for (int e = 0; e < mesh->element_count; e++) {
        const int *n = mesh->elements + (size_t)e * 10;
        sb_vec3 a = mesh->nodes[n[8]], b = mesh->nodes[n[9]], d = mesh->nodes[n[3]];
        sb_vec3 edge13 = sb_v3_scale((sb_real)0.5, sb_v3_add(mesh->nodes[n[1]], d));
        sb_vec3 edge23 = sb_v3_scale((sb_real)0.5, sb_v3_add(mesh->nodes[n[2]], d));
        if (!(sb_v3_norm(sb_v3_sub(a, edge23)) < sb_v3_norm(sb_v3_sub(a, edge13)) &&
              sb_v3_norm(sb_v3_sub(b, edge13)) < sb_v3_norm(sb_v3_sub(b, edge23))))
            return 0;
    }
    return mesh->element_count > 0;
}

/* Puts gmsh's order right when that was asked for; else says what it is. */
static sb_result sbi_meshio_mend_order(sb_mesh *mesh, int mend, int *reordered, sb_error *error)
{
    if (mesh->element_type != SB_TET10 || !sbi_meshio_has_gmsh_order(mesh))
        return SB_OK;
    if (!mend)
        return sbi_fail_element(error, SB_ERROR_MESH, 0,
                                "the last two mid-edge nodes of all %d tet10 are exchanged: this is gmsh's node order, "
                                "not VTK's (fix_orientation puts it right)",
                                mesh->element_count);
    for (int e = 0; e < mesh->element_count; e++) {
        int *n = mesh->elements + (size_t)e * 10, hold = n[8];
        n[8] = n[9];
        n[9] = hold;
    }
    *reordered = mesh->element_count;
    return SB_OK;
}

/* A volume must be one that can be computed with. Elements that are all inverted are a convention of the
 * file's program and are turned; some of them only when the caller asked for it. */
static sb_result sbi_meshio_accept_volume(sb_mesh *mesh, int fix_orientation, int *flipped, sb_error *error)
{
    sb_error found;
    sb_result result = sb_mesh_validate(mesh, &found), oriented = SB_OK;
    if (result == SB_ERROR_MESH) {
        sb_error failure;
        oriented = sb_mesh_orient(mesh, flipped, &failure);
        if (oriented == SB_ERROR_MEMORY) {
            found = failure;
            result = oriented;
        } else if (!oriented && *flipped > 0 && (*flipped == mesh->element_count || fix_orientation)) {
            result = sb_mesh_validate(mesh, &found);
        }
    }
    if (result && error)
        *error = found;
    return result;
}

/* What was changed in the mesh to accept it. */
typedef struct sbi_meshio_changes {
    int flipped, reordered;
} sbi_meshio_changes;

static sb_result sbi_meshio_accept(sb_mesh *mesh, int mend, sbi_meshio_changes *changes, sb_error *error)
{
    sb_result result;
    if (sb_element_dimension(mesh->element_type) == 2)
        return mend ? sb_mesh_orient_surface(mesh, &changes->flipped, error) : SB_OK;
    result = sbi_meshio_mend_order(mesh, mend, &changes->reordered, error);
    return result ? result : sbi_meshio_accept_volume(mesh, mend, &changes->flipped, error);
}

/* Nodes that no element uses; -1 without memory. */
static int sbi_meshio_count_unreferenced(const sb_mesh *mesh)
{
    size_t used = (size_t)mesh->element_count * (size_t)sb_element_node_count(mesh->element_type);
    unsigned char *seen = (unsigned char *)sbi_alloc_zeroed(&mesh->allocator, (size_t)mesh->node_count, 1);
    int count = 0;
    if (!seen)
        return -1;
    for (size_t i = 0; i < used; i++)
        seen[mesh->elements[i]] = 1;
    for (int i = 0; i < mesh->node_count; i++)
        count += !seen[i];
    sbi_free(&mesh->allocator, seen);
    return count;
}

/* Appends a sentence to the report. */
static void sbi_meshio_note(sb_load_report *report, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 2, 3)))
#endif
    ;
static void sbi_meshio_note(sb_load_report *report, const char *format, ...)
{
    va_list arguments;
    if (report->note_count >= SB_LOAD_NOTES)
        return;
    va_start(arguments, format);
    vsnprintf(report->notes[report->note_count++], SB_LOAD_NOTE_LENGTH, format, arguments);
    va_end(arguments);
}

/* Names of groups that nobody asked for. */
static void sbi_meshio_note_names(const sbi_loader *loader, sb_load_report *report)
{
    char text[120];
    size_t used = 0;
    for (size_t i = 0; i < loader->name_count && used + 8 < sizeof text; i++) {
        size_t length = strlen(loader->names[i].text);
        int fits = used + length + 8 < sizeof text;
        snprintf(text + used, sizeof text - used, "%s%s", used ? ", " : "", fits ? loader->names[i].text : "...");
        used = fits ? used + length + (used ? 2 : 0) : sizeof text;
    }
    if (loader->name_count)
        sbi_meshio_note(report, "named groups are in the file, but no sets were asked for: %s", text);
}

static void sbi_meshio_write_notes(const sbi_loader *loader, const sb_load_options *options, const sb_mesh *mesh,
                                   const sbi_meshio_changes *changes, sb_load_report *report)
{
    if (loader->split_cells)
        sbi_meshio_note(report, "%d pyramids, wedges or hexahedra were cut into %d %s", loader->split_cells,
                        loader->split_tets, sb_element_name(mesh->element_type));
    if (loader->diagonal_nodes)
        sbi_meshio_note(report, "%d nodes are new, in the middle of diagonals", loader->diagonal_nodes);
    if (changes->reordered)
        sbi_meshio_note(report, "%d tet10 had gmsh's node order and were put in VTK's", changes->reordered);
    if (report->flipped_elements)
        sbi_meshio_note(report, "%d elements were inside out and were turned", report->flipped_elements);
    if (loader->region_rank && mesh->regions && strcmp(loader->region_field, "region") != 0)
        sbi_meshio_note(report, "regions are the cell field %s", loader->region_field);
    if (!options->sets)
        sbi_meshio_note_names(loader, report);
    if (loader->pieces > 1)
        sbi_meshio_note(report, "%d pieces were joined; nodes at the same place in several of them are still several",
                        loader->pieces);
    if (loader->skipped_cells && !options->sets)
        sbi_meshio_note(report, "%d cells of lower dimension are not part of the mesh", loader->skipped_cells);
    if (loader->ignored_count)
        sbi_meshio_note(report, "not taken (%d): %s", loader->ignored_count, loader->ignored);
}

static sb_result sbi_meshio_report(const sbi_loader *loader, const sb_load_options *options, const sb_mesh *mesh,
                                   sb_file_format format, const sbi_meshio_changes *changes, sb_load_report *report)
{
    int unreferenced = sbi_meshio_count_unreferenced(mesh);
    if (unreferenced < 0)
        return sbi_loader_no_memory(loader);
    memset(report, 0, sizeof *report);
    report->format = format;
    report->file_cells = loader->source_count;
    report->skipped_cells = loader->skipped_cells;
    report->split_polygons = loader->split_polygons;
    report->split_cells = loader->split_cells;
    report->merged_vertices = loader->merged_vertices;
    report->flipped_elements = changes->flipped + loader->flipped_tets;
    report->unreferenced_nodes = unreferenced;
    report->ignored = loader->ignored_count;
    sbi_meshio_write_notes(loader, options, mesh, changes, report);
    return SB_OK;
}

/* From the cells of the file to the caller's mesh, sets and report. */
static sb_result sbi_meshio_finish(sbi_loader *loader, const sb_load_options *options, sb_file_format format,
                                   sb_mesh *mesh)
{
    sb_mesh loaded;
    sb_mesh_sets sets;
    sbi_meshio_changes changes = {0, 0};
    sb_error *error = loader->reader.error;
    sb_result result;
    memset(&loaded, 0, sizeof loaded);
    memset(&sets, 0, sizeof sets);
    result = sbi_loader_build(loader, &loaded);
    if (!result) {
        result = sbi_meshio_accept(&loaded, options->fix_orientation, &changes, error);
        if (result && error)
            sbi_error_set_file(error, loader->reader.name);
    }
    if (!result && options->sets)
        result = sbi_sets_make(loader, &loaded, &sets);
    if (!result && options->report)
        result = sbi_meshio_report(loader, options, &loaded, format, &changes, options->report);
    if (result) {
        sb_mesh_free(&loaded);
        sb_mesh_sets_free(&sets);
        return result;
    }
    *mesh = loaded;
    if (options->sets)
        *options->sets = sets;
    return SB_OK;
}

SBI_API void sbi_loader_set_content(sbi_loader *loader, const char *data, size_t size, const char *name)
{
    sb_error *error = loader->reader.error;
    if (size >= 3 && memcmp(data, "\xEF\xBB\xBF", 3) == 0 && !sbi_stl_is_binary(data, size)) {
        data += 3;
        size -= 3;
    }
    sbi_reader_init(&loader->reader, data, size, name, error);
}

SB_API sb_result sb_mesh_load_memory(sb_mesh *mesh, const void *data, size_t size, sb_file_format format,
                                     const char *name, const sb_load_options *options, sb_error *error)
{
    sb_load_options resolved;
    sbi_loader loader;
    sb_result result = sbi_load_options_resolve(options, &resolved, error);
    if (result)
        return result;
    if (!mesh || (!data && size))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", mesh ? "data" : "mesh");
    if ((int)format < SB_FILE_AUTO || (int)format > SB_FILE_MEDIT)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d is not a file format", (int)format);
    sbi_loader_init(&loader, &resolved, error);
    sbi_loader_set_content(&loader, size ? (const char *)data : "", size, name);
    result = sbi_file_detect(&loader.reader, &format);
    if (!result)
        result = sbi_loader_parse(&loader, format);
    if (!result)
        result = sbi_meshio_finish(&loader, &resolved, format, mesh);
    sbi_loader_free(&loader);
    return result;
}

/* A copy of the path with its ending, of `cut` characters, replaced; NULL without memory. */
static char *sbi_meshio_change_ending(const sb_allocator *allocator, const char *path, size_t cut, const char *ending)
{
    size_t stem = strlen(path) - cut, tail = strlen(ending) + 1;
    char *changed = (char *)sbi_alloc(allocator, stem + tail, 1);
    if (changed) {
        memcpy(changed, path, stem);
        memcpy(changed + stem, ending, tail);
    }
    return changed;
}

/* One of TetGen's files: reads it, parses it and lets the content go. */
static sb_result sbi_meshio_read_part(sbi_loader *loader, const char *path, int is_nodes, int64_t *base)
{
    sbi_file content;
    sb_result result = sbi_file_read(&loader->allocator, path, &content, loader->reader.error);
    if (!result) {
        sbi_loader_set_content(loader, content.data, content.size, path);
        result = is_nodes ? sbi_tetgen_read_nodes(loader, base) : sbi_tetgen_read_elements(loader, *base);
    }
    sbi_free(&loader->allocator, content.data);
    return result;
}

static sb_result sbi_meshio_load_tetgen(sbi_loader *loader, const char *path, const sb_load_options *options,
                                        sb_mesh *mesh)
{
    const sb_allocator *allocator = &loader->allocator;
    size_t cut = sbi_meshio_name_ends_with(path, ".node") ? 5 : 4;
    /* the other file's name in the same case, for file systems that distinguish it */
    int capitals = path[strlen(path) - cut + 1] < 'a';
    char *nodes = sbi_meshio_change_ending(allocator, path, cut, capitals ? ".NODE" : ".node");
    char *elements = sbi_meshio_change_ending(allocator, path, cut, capitals ? ".ELE" : ".ele");
    int64_t base = 0;
    sb_result result = nodes && elements ? SB_OK : sbi_loader_no_memory(loader);
    if (!result)
        result = sbi_meshio_read_part(loader, nodes, 1, &base);
    if (!result)
        result = sbi_meshio_read_part(loader, elements, 0, &base);
    if (!result)
        result = sbi_meshio_finish(loader, options, SB_FILE_TETGEN, mesh);
    sbi_free(allocator, nodes);
    sbi_free(allocator, elements);
    return result;
}

SB_API sb_result sb_mesh_load(sb_mesh *mesh, const char *path, const sb_load_options *options, sb_error *error)
{
    sb_load_options resolved;
    sb_file_format format = SB_FILE_AUTO;
    sbi_loader loader;
    sbi_file content;
    sb_result result = sbi_load_options_resolve(options, &resolved, error);
    if (result)
        return result;
    if (!mesh || !path)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", mesh ? "path" : "mesh");
    sbi_loader_init(&loader, &resolved, error);
    result = sbi_file_read(&loader.allocator, path, &content, error);
    if (!result) {
        sbi_loader_set_content(&loader, content.data, content.size, path);
        result = sbi_file_detect(&loader.reader, &format);
    }
    if (!result && format == SB_FILE_TETGEN)
        result = sbi_meshio_load_tetgen(&loader, path, &resolved, mesh);
    else if (!result) {
        result = sbi_loader_parse(&loader, format);
        if (!result)
            result = sbi_meshio_finish(&loader, &resolved, format, mesh);
    }
    sbi_free(&loader.allocator, content.data);
    sbi_loader_free(&loader);
    return result;
}

/* ==== writing ====================================================================================== */

SBI_API sb_result sbi_export_open(sbi_export *out, const char *path, int binary, sb_error *error)
{
    out->binary = binary;
    out->failed = 0;
    return sb_output_open(&out->output, path, error);
}

SBI_API sb_result sbi_export_close(sbi_export *out, sb_error *error) { return sb_output_close(&out->output, error); }

static SBI_NOINLINE void sbi_export_bytes(sbi_export *out, const void *bytes, size_t size)
{
    if (!out->failed && fwrite(bytes, 1, size, out->output.file) != size)
        out->failed = 1; /* sb_output_close reports it; the rest would fail as well */
}

SBI_API void sbi_export_text(sbi_export *out, const char *text) { sbi_export_bytes(out, text, strlen(text)); }

SBI_API void sbi_export_bits(sbi_export *out, uint64_t bits, int size, int big_endian)
{
    unsigned char bytes[8];
    for (int i = 0; i < size; i++)
        bytes[big_endian ? size - 1 - i : i] = (unsigned char)(bits >> (8 * i) & 0xFF);
    sbi_export_bytes(out, bytes, (size_t)size);
}

static uint64_t sbi_export_float_bits(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

SBI_API uint64_t sbi_export_real_bits(sb_real value)
{
#if SB_REAL_IS_FLOAT
    return sbi_export_float_bits(value);
#else
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
#endif
}

SBI_API void sbi_export_print_real(sbi_export *out, sb_real value)
{
    char text[48], clean[48];
    size_t length = 0;
    snprintf(text, sizeof text, SB_REAL_IS_FLOAT ? "%.9g" : "%.17g", (double)value);
    for (const char *p = text; *p; p++) {
        int part = (*p >= '0' && *p <= '9') || *p == '-' || *p == '+' || *p == 'e';
        if (part)
            clean[length++] = *p;
        else if (length == 0 || clean[length - 1] != '.')
            clean[length++] = '.';
    }
    sbi_export_bytes(out, clean, length);
}

/* `count` numbers as one row; in a binary file big-endian, as VTK has them. */
static void sbi_export_reals(sbi_export *out, const sb_real *values, int count)
{
    for (int i = 0; i < count; i++) {
        if (out->binary) {
            sbi_export_bits(out, sbi_export_real_bits(values[i]), (int)sizeof(sb_real), 1);
            continue;
        }
        sbi_export_print_real(out, values[i]);
        sbi_export_text(out, i + 1 < count ? " " : "\n");
    }
}

static void sbi_export_integer(sbi_export *out, int value, const char *after)
{
    char text[16];
    if (out->binary) {
        sbi_export_bits(out, (uint64_t)(int64_t)value, 4, 1);
        return;
    }
    snprintf(text, sizeof text, "%d", value);
    sbi_export_text(out, text);
    sbi_export_text(out, after);
}

static void sbi_export_node(sbi_export *out, sb_vec3 node)
{
    sb_real x[3];
    x[0] = node.x;
    x[1] = node.y;
    x[2] = node.z;
    sbi_export_reals(out, x, 3);
}

/* ---- VTK ---- */

#define SBI_EXPORT_REAL_NAME (SB_REAL_IS_FLOAT ? "float" : "double")

/* A line of text with a number, in binary files too. */
static void sbi_export_line(sbi_export *out, const char *keyword, long long number, const char *after)
{
    char text[32];
    snprintf(text, sizeof text, " %lld", number);
    sbi_export_text(out, keyword);
    sbi_export_text(out, text);
    sbi_export_text(out, after);
}

/* VTK reads binary numbers up to their last byte and then looks for the next line. */
static void sbi_export_end_binary(sbi_export *out)
{
    if (out->binary)
        sbi_export_text(out, "\n");
}

static sb_result sbi_export_check_field(const sb_field *field, const sb_mesh *mesh, sb_error *error)
{
    static const char usable[] = {1, 2, 3, 4, 6, 9};
    int at_nodes = field->location == SB_FIELD_NODES, known = 0;
    size_t rows = (size_t)(at_nodes ? mesh->node_count : mesh->element_count);
    if (!field->name || !field->name[0] || !field->values)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a field without a name or values");
    for (const char *p = field->name; *p; p++)
        if (*p <= ' ' || *p > '~')
            return sbi_fail(error, SB_ERROR_ARGUMENT, "the field name '%s' has characters VTK cannot hold",
                            field->name);
    if (!at_nodes && field->location != SB_FIELD_ELEMENTS)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "field %s: unknown location", field->name);
    for (size_t i = 0; i < sizeof usable; i++)
        known |= field->components == usable[i];
    if (!known)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "field %s: %d components", field->name, field->components);
    for (size_t i = 0; i < rows * (size_t)field->components; i++)
        if (!sb_is_finite(field->values[i])) {
            int row = (int)(i / (size_t)field->components);
            return at_nodes ? sbi_fail_node(error, SB_ERROR_NOT_FINITE, row, "field %s is not finite", field->name)
                            : sbi_fail_element(error, SB_ERROR_NOT_FINITE, row, "field %s is not finite", field->name);
        }
    if (!at_nodes && mesh->regions && strcmp(field->name, "region") == 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the element field region comes from the mesh");
    return SB_OK;
}

static void sbi_export_field(sbi_export *out, const sb_field *field, int rows)
{
    int components = field->components;
    int is_vector = components == 3, is_tensor = components > 4;
    sbi_export_text(out, is_vector ? "VECTORS " : is_tensor ? "TENSORS " : "SCALARS ");
    sbi_export_text(out, field->name);
    sbi_export_text(out, " ");
    if (is_vector || is_tensor) {
        sbi_export_text(out, SBI_EXPORT_REAL_NAME);
        sbi_export_text(out, "\n");
    } else {
        sbi_export_line(out, SBI_EXPORT_REAL_NAME, components, "\nLOOKUP_TABLE default\n");
    }
    for (int i = 0; i < rows; i++) {
        const sb_real *value = field->values + (size_t)i * (size_t)components;
        static const int symmetric[9] = {0, 3, 5, 3, 1, 4, 5, 4, 2}; /* of xx yy zz xy yz xz */
        sb_real full[9];
        for (int k = 0; k < 9 && components == 6; k++)
            full[k] = value[symmetric[k]];
        sbi_export_reals(out, components == 6 ? full : value, components == 6 ? 9 : components);
    }
    sbi_export_end_binary(out);
}

/* The section POINT_DATA or CELL_DATA, when there is anything for it. */
static void sbi_export_data(sbi_export *out, const sb_mesh *mesh, const sb_field *fields, int field_count,
                            sb_field_location location)
{
    int at_nodes = location == SB_FIELD_NODES, rows = at_nodes ? mesh->node_count : mesh->element_count;
    int with_regions = !at_nodes && mesh->regions, any = with_regions;
    for (int i = 0; i < field_count; i++)
        any |= fields[i].location == location;
    if (!any)
        return;
    sbi_export_line(out, at_nodes ? "POINT_DATA" : "CELL_DATA", rows, "\n");
    if (with_regions) {
        sbi_export_text(out, "SCALARS region int 1\nLOOKUP_TABLE default\n");
        for (int i = 0; i < rows; i++)
            sbi_export_integer(out, mesh->regions[i], "\n");
        sbi_export_end_binary(out);
    }
    for (int i = 0; i < field_count; i++)
        if (fields[i].location == location)
            sbi_export_field(out, &fields[i], rows);
}

/* VTK's number of a mesh's element type; 0: none. */
static int sbi_export_vtk_type(const sb_mesh *mesh)
{
    sb_element_type type = mesh->element_type;
    if (type == SB_CUSTOM)
        return mesh->table->vtk_type;
    for (int kind = 0; kind < SBI_CELL_KINDS; kind++)
        if (sbi_cell_kind_at(kind)->type == type)
            return sbi_cell_kind_at(kind)->vtk;
    return 0;
}

static void sbi_export_vtk_mesh(sbi_export *out, const sb_mesh *mesh)
{
    int nodes = sb_mesh_element_width(mesh), type = sbi_export_vtk_type(mesh);
    sbi_export_text(out, "# vtk DataFile Version 3.0\nsoftbody mesh (metre)\n");
    sbi_export_text(out, out->binary ? "BINARY\n" : "ASCII\n");
    sbi_export_text(out, "DATASET UNSTRUCTURED_GRID\n");
    sbi_export_line(out, "POINTS", mesh->node_count, " ");
    sbi_export_text(out, SBI_EXPORT_REAL_NAME);
    sbi_export_text(out, "\n");
    for (int i = 0; i < mesh->node_count; i++)
        sbi_export_node(out, mesh->nodes[i]);
    sbi_export_end_binary(out);
    sbi_export_line(out, "CELLS", mesh->element_count, "");
    sbi_export_line(out, "", (long long)mesh->element_count * (nodes + 1), "\n");
    for (int i = 0; i < mesh->element_count; i++) {
        sbi_export_integer(out, nodes, " ");
        for (int k = 0; k < nodes; k++)
            sbi_export_integer(out, mesh->elements[(size_t)i * (size_t)nodes + (size_t)k], k + 1 < nodes ? " " : "\n");
    }
    sbi_export_end_binary(out);
    sbi_export_line(out, "CELL_TYPES", mesh->element_count, "\n");
    for (int i = 0; i < mesh->element_count; i++)
        sbi_export_integer(out, type, "\n");
    sbi_export_end_binary(out);
}

static sb_result sbi_export_vtk(const char *path, const sb_mesh *mesh, const sb_field *fields, int field_count,
                                int binary, sb_error *error)
{
    sbi_export out;
    sb_result result;
    if (!path || !mesh || field_count < 0 || (field_count > 0 && !fields))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s",
                        field_count < 0 ? "a negative number of fields" : "path, mesh or fields is NULL");
    result = sbi_mesh_check_arrays(mesh, error);
    if (!result && sbi_export_vtk_type(mesh) == 0)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "VTK has no cell for the element %s: its table has no vtk_type",
                        sbi_element_name(sbi_mesh_element_kind(mesh)));
    for (int i = 0; i < field_count && !result; i++)
        result = sbi_export_check_field(&fields[i], mesh, error);
    if (!result)
        result = sbi_export_open(&out, path, binary, error);
    if (result)
        return result;
    sbi_export_vtk_mesh(&out, mesh);
    sbi_export_data(&out, mesh, fields, field_count, SB_FIELD_ELEMENTS);
    sbi_export_data(&out, mesh, fields, field_count, SB_FIELD_NODES);
    return sbi_export_close(&out, error);
}

SB_API sb_result sb_mesh_save_vtk(const char *path, const sb_mesh *mesh, const sb_field *fields, int field_count,
                                  sb_error *error)
{
    return sbi_export_vtk(path, mesh, fields, field_count, 0, error);
}

SB_API sb_result sb_mesh_save_vtk_binary(const char *path, const sb_mesh *mesh, const sb_field *fields, int field_count,
                                         sb_error *error)
{
    return sbi_export_vtk(path, mesh, fields, field_count, 1, error);
}

/* ---- surfaces ---- */

static sb_result sbi_export_check_surface(const char *path, const sb_mesh *mesh, sb_error *error)
{
    sb_result result;
    if (!path || !mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "path or mesh is NULL");
    result = sbi_mesh_check_arrays(mesh, error);
    if (result)
        return result;
    if (mesh->element_type == SB_TRI3 || mesh->element_type == SB_QUAD4)
        return SB_OK;
    if (sb_element_dimension(mesh->element_type) == 2)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "curved faces (%s) cannot be written as a surface file",
                        sb_element_name(mesh->element_type));
    return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                    "a volume mesh cannot be written as a surface file: write its sb_mesh_boundary");
}

/* The nodes of element i. */
static const int *sbi_export_element(const sb_mesh *mesh, int i)
{
    return mesh->elements + (size_t)i * (size_t)sb_element_node_count(mesh->element_type);
}

SB_API sb_result sb_mesh_save_obj(const char *path, const sb_mesh *mesh, sb_error *error)
{
    sbi_export out;
    int nodes;
    sb_result result = sbi_export_check_surface(path, mesh, error);
    if (!result)
        result = sbi_export_open(&out, path, 0, error);
    if (result)
        return result;
    nodes = sb_element_node_count(mesh->element_type);
    for (int i = 0; i < mesh->node_count; i++) {
        sbi_export_text(&out, "v ");
        sbi_export_node(&out, mesh->nodes[i]);
    }
    for (int i = 0; i < mesh->element_count; i++) {
        const int *element = sbi_export_element(mesh, i);
        sbi_export_text(&out, "f ");
        for (int k = 0; k < nodes; k++)
            sbi_export_line(&out, "", (long long)element[k] + 1, k + 1 < nodes ? "" : "\n");
    }
    return sbi_export_close(&out, error);
}

/* A facet of binary STL: normal, three corners, two bytes of nothing. */
static void sbi_export_facet(sbi_export *out, const sb_mesh *mesh, int a, int b, int c)
{
    sb_vec3 corners[4];
    sb_real length;
    corners[1] = mesh->nodes[a];
    corners[2] = mesh->nodes[b];
    corners[3] = mesh->nodes[c];
    corners[0] = sb_v3_cross(sb_v3_sub(corners[2], corners[1]), sb_v3_sub(corners[3], corners[1]));
    length = sb_v3_norm(corners[0]);
    corners[0] = length > 0 && sb_is_finite(length) ? sb_v3_scale(1 / length, corners[0]) : sb_v3(0, 0, 0);
    for (int i = 0; i < 4; i++) {
        sbi_export_bits(out, sbi_export_float_bits((float)corners[i].x), 4, 0);
        sbi_export_bits(out, sbi_export_float_bits((float)corners[i].y), 4, 0);
        sbi_export_bits(out, sbi_export_float_bits((float)corners[i].z), 4, 0);
    }
    sbi_export_bits(out, 0, 2, 0);
}

SB_API sb_result sb_mesh_save_stl(const char *path, const sb_mesh *mesh, sb_error *error)
{
    const double limit = (double)FLT_MAX;
    char header[80];
    sbi_export out;
    int quads;
    sb_result result = sbi_export_check_surface(path, mesh, error);
    for (int i = 0; !result && i < mesh->node_count; i++) {
        sb_vec3 x = mesh->nodes[i];
        if (fabs((double)x.x) > limit || fabs((double)x.y) > limit || fabs((double)x.z) > limit)
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "a coordinate of node %d is too large for STL", i);
    }
    if (!result)
        result = sbi_export_open(&out, path, 1, error);
    if (result)
        return result;
    quads = mesh->element_type == SB_QUAD4;
    memset(header, ' ', sizeof header);
    memcpy(header, "binary STL (metre)", 18); /* must not begin with "solid", the mark of the ASCII form */
    sbi_export_bytes(&out, header, sizeof header);
    sbi_export_bits(&out, (uint64_t)mesh->element_count * (quads ? 2u : 1u), 4, 0);
    for (int i = 0; i < mesh->element_count; i++) {
        const int *element = sbi_export_element(mesh, i);
        sbi_export_facet(&out, mesh, element[0], element[1], element[2]);
        if (quads)
            sbi_export_facet(&out, mesh, element[0], element[2], element[3]);
    }
    return sbi_export_close(&out, error);
}

SB_API sb_result sb_mesh_save_ply(const char *path, const sb_mesh *mesh, sb_error *error)
{
    sbi_export out;
    int nodes;
    sb_result result = sbi_export_check_surface(path, mesh, error);
    if (!result)
        result = sbi_export_open(&out, path, 1, error);
    if (result)
        return result;
    nodes = sb_element_node_count(mesh->element_type);
    sbi_export_text(&out, "ply\nformat binary_little_endian 1.0\ncomment unit: metre\n");
    sbi_export_line(&out, "element vertex", mesh->node_count, "\n");
    for (char axis = 'x'; axis <= 'z'; axis++) {
        char property[32];
        snprintf(property, sizeof property, "property %s %c\n", SBI_EXPORT_REAL_NAME, axis);
        sbi_export_text(&out, property);
    }
    sbi_export_line(&out, "element face", mesh->element_count,
                    "\nproperty list uchar int vertex_indices\nend_header\n");
    for (int i = 0; i < mesh->node_count; i++) {
        sbi_export_bits(&out, sbi_export_real_bits(mesh->nodes[i].x), (int)sizeof(sb_real), 0);
        sbi_export_bits(&out, sbi_export_real_bits(mesh->nodes[i].y), (int)sizeof(sb_real), 0);
        sbi_export_bits(&out, sbi_export_real_bits(mesh->nodes[i].z), (int)sizeof(sb_real), 0);
    }
    for (int i = 0; i < mesh->element_count; i++) {
        const int *element = sbi_export_element(mesh, i);
        sbi_export_bits(&out, (uint64_t)nodes, 1, 0);
        for (int k = 0; k < nodes; k++)
            sbi_export_bits(&out, (uint64_t)element[k], 4, 0);
    }
    return sbi_export_close(&out, error);
}
#undef SBI_EXPORT_REAL_NAME
