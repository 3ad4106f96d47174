/* meshio_surface: reads OBJ, STL, PLY and OFF. Sources of the formats: Wavefront "Object Files (.obj)"; 3D
 * Systems "StereoLithography Interface Specification"; G. Turk, "The PLY Polygon File Format"; Geomview
 * manual, "OFF". */
#include "meshio_reader.h"

#include <limits.h>
#include <string.h>

/* The next word, which must be the keyword. */
static sb_result sbi_surface_expect(sbi_reader *reader, const char *keyword)
{
    sbi_word word;
    char text[32];
    if (!sbi_reader_word(reader, &word))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends where %s should be", keyword);
    if (!sbi_word_is(word, keyword))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s' instead of %s", sbi_word_print(word, text), keyword);
    return SB_OK;
}

/* ==== OBJ ========================================================================================== */

typedef struct sbi_obj {
    sbi_loader *loader;
    sbi_reader *reader;
    int seen; /* vertices on the lines so far, for relative indices */
} sbi_obj;

/* Reads the numbers of the line; at least `low` and at most `high` of them. The first three go to x. */
static sb_result sbi_obj_numbers(sbi_obj *obj, int low, int high, double x[3])
{
    sbi_reader *reader = obj->reader;
    sb_result result = SB_OK;
    int count = 0;
    for (; !sbi_reader_at_line_end(reader) && !result; count++) {
        double value = 0;
        result = sbi_reader_real(reader, "coordinate", &value);
        if (count < 3)
            x[count] = value;
        if (count == high && !result)
            return sbi_reader_fail(reader, SB_ERROR_FORMAT, "a vertex of more than %d numbers", high);
    }
    if (!result && count < low)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "a vertex of %d numbers", count);
    return result;
}

/* v x y z, then perhaps a weight or a colour. */
static sb_result sbi_obj_vertex(sbi_obj *obj)
{
    double x[3] = {0, 0, 0};
    sb_result result;
    obj->reader->node = (int)obj->loader->node_count;
    result = sbi_obj_numbers(obj, 3, 7, x);
    return result ? result : sbi_loader_add_node(obj->loader, x);
}

/* One corner: v, v/vt, v//vn or v/vt/vn. */
static sb_result sbi_obj_corner(sbi_obj *obj, sbi_word word)
{
    int64_t vertex = 0, other = 0;
    size_t start = 0;
    char text[32];
    for (int part = 0; start <= word.length && part < 4; part++) {
        size_t end = start;
        int parsed;
        while (end < word.length && word.text[end] != '/')
            end++;
        parsed = sbi_parse_integer(word.text + start, end - start, part == 0 ? &vertex : &other);
        if (part == 3 || (parsed <= 0 && !(part == 1 && end == start && end + 1 < word.length)))
            return sbi_reader_fail(obj->reader, SB_ERROR_FORMAT, "'%s' is not a corner of a face",
                                   sbi_word_print(word, text));
        start = end + 1;
    }
    if (vertex == 0)
        return sbi_reader_fail(obj->reader, SB_ERROR_INDEX, "vertex index 0: OBJ counts from 1");
    if (vertex < 0 && vertex < -(int64_t)obj->seen)
        return sbi_reader_fail(obj->reader, SB_ERROR_INDEX, "relative vertex index %lld after %d vertices",
                               (long long)vertex, obj->seen);
    return sbi_loader_cell_node(obj->loader, vertex < 0 ? obj->seen + vertex + 1 : vertex, 1);
}

static sb_result sbi_obj_face(sbi_obj *obj)
{
    sbi_word word;
    sb_result result = SB_OK;
    sbi_loader_begin_cell(obj->loader);
    while (!result && sbi_reader_line_word(obj->reader, &word))
        result = sbi_obj_corner(obj, word);
    return result ? result : sbi_loader_end_polygon(obj->loader, 0);
}

/* One line: vertices count in pass 0, faces in pass 1, since a face may refer to vertices further down. */
static sb_result sbi_obj_line(sbi_obj *obj, int pass)
{
    sbi_word word;
    char text[32];
    if (!sbi_reader_line_word(obj->reader, &word))
        return SB_OK;
    if (word.length == 1 && word.text[0] == 'v') {
        obj->seen++;
        return pass == 0 ? sbi_obj_vertex(obj) : SB_OK;
    }
    if (pass == 1 && word.length == 1 && word.text[0] == 'f')
        return sbi_obj_face(obj);
    for (size_t i = 0; i < word.length && i < 2; i++)
        if (!((word.text[i] >= 'a' && word.text[i] <= 'z') || (word.text[i] >= 'A' && word.text[i] <= 'Z')))
            return sbi_reader_fail(obj->reader, SB_ERROR_FORMAT, "'%s' where an OBJ keyword should be",
                                   sbi_word_print(word, text));
    return SB_OK; /* normals, texture, groups, materials, curves */
}

/* Steps behind the line and, for vertices and faces, the lines it continues on: only there a backslash
 * continues a line, since names may end in one. */
static sb_result sbi_obj_pass(sbi_obj *obj, int pass)
{
    sb_result result = SB_OK;
    obj->seen = 0;
    while (sbi_reader_left(obj->reader) && !result) {
        sbi_word word;
        sbi_reader ahead = *obj->reader;
        ahead.continuation = 0;
        obj->reader->continuation =
            sbi_reader_line_word(&ahead, &word) && (sbi_word_is(word, "v") || sbi_word_is(word, "f"));
        result = sbi_obj_line(obj, pass);
        if (!result && obj->reader->continuation)
            while (!sbi_reader_at_line_end(obj->reader))
                sbi_reader_line_word(obj->reader, &word);
        if (!result)
            sbi_reader_next_line(obj->reader);
    }
    return result;
}

SBI_API sb_result sbi_obj_read(sbi_loader *loader)
{
    sbi_obj obj;
    sb_result result;
    obj.loader = loader;
    obj.reader = &loader->reader;
    obj.reader->comment = '#';
    result = sbi_reader_check_text(obj.reader);
    if (!result)
        result = sbi_obj_pass(&obj, 0);
    if (result)
        return result;
    obj.reader->at = 0;
    obj.reader->line = 1;
    return sbi_obj_pass(&obj, 1);
}

/* ==== STL ========================================================================================== */

enum { SBI_STL_HEADER = 84, SBI_STL_FACET = 50 };

static uint64_t sbi_stl_count(const char *data)
{
    sbi_reader reader;
    sbi_reader_init(&reader, data, SBI_STL_HEADER, NULL, NULL);
    return sbi_decode_bits(&reader, (const unsigned char *)data + 80, 4);
}

SBI_API int sbi_stl_is_binary(const char *data, size_t size)
{
    return size >= SBI_STL_HEADER && (uint64_t)(size - SBI_STL_HEADER) == SBI_STL_FACET * sbi_stl_count(data);
}

/* 80 bytes of text, the count; per facet a normal and three corners as floats, and two bytes. */
static sb_result sbi_stl_binary(sbi_loader *loader)
{
    sbi_reader *reader = &loader->reader;
    const unsigned char *facets;
    uint64_t count;
    sb_result result = SB_OK;
    reader->binary = 1;
    if (reader->size < SBI_STL_HEADER)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "neither an ASCII nor a binary STL file");
    count = sbi_stl_count(reader->data);
    reader->at = SBI_STL_HEADER;
    if (!sbi_stl_is_binary(reader->data, reader->size))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file says %llu facets, but has %llu bytes for them",
                               (unsigned long long)count, (unsigned long long)sbi_reader_left(reader));
    if (count > INT_MAX / 3)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 corners");
    facets = sbi_reader_bytes(reader, (size_t)count, SBI_STL_FACET, "facets");
    result = facets ? sbi_loader_reserve_nodes(loader, (int)count * 3) : SB_ERROR_FORMAT;
    for (size_t i = 0; i < (size_t)count * 3 && !result; i++) {
        const unsigned char *corner = facets + i / 3 * SBI_STL_FACET + 12 + i % 3 * 12;
        double x[3];
        for (int k = 0; k < 3; k++)
            x[k] = sbi_decode_float(reader, corner + 4 * k, 4);
        reader->element = (int)(i / 3);
        result = sbi_loader_add_node(loader, x);
    }
    return result;
}

/* After "facet": normal, loop, three vertices. */
static sb_result sbi_stl_facet(sbi_loader *loader)
{
    sbi_reader *reader = &loader->reader;
    sb_result result = sbi_surface_expect(reader, "normal");
    if (loader->node_count > INT_MAX - 3)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 corners");
    reader->element = (int)(loader->node_count / 3);
    if (!result)
        result = sbi_reader_skip_words(reader, 3, "a normal"); /* often not a number; the corners give it */
    if (!result)
        result = sbi_surface_expect(reader, "outer");
    if (!result)
        result = sbi_surface_expect(reader, "loop");
    for (int i = 0; i < 3 && !result; i++) {
        result = sbi_surface_expect(reader, "vertex");
        if (!result)
            result = sbi_loader_read_node(loader);
    }
    if (!result)
        result = sbi_surface_expect(reader, "endloop");
    if (!result)
        result = sbi_surface_expect(reader, "endfacet");
    reader->element = -1;
    return result;
}

/* "solid" and a name, facets, "endsolid"; perhaps several of them. */
static sb_result sbi_stl_ascii(sbi_loader *loader)
{
    sbi_reader *reader = &loader->reader;
    sbi_word word;
    char text[32];
    int inside = 0;
    sb_result result = SB_OK;
    while (!result && sbi_reader_word(reader, &word)) {
        if (inside && sbi_word_is(word, "facet")) {
            result = sbi_stl_facet(loader);
        } else if (sbi_word_is(word, inside ? "endsolid" : "solid")) {
            inside = !inside;
            sbi_reader_next_line(reader);
        } else {
            return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s' where %s should be", sbi_word_print(word, text),
                                   inside ? "facet or endsolid" : "solid");
        }
    }
    if (!result && inside)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends without endsolid");
    return result;
}

/* Values, so that 0 and -0 are one. */
static int sbi_stl_before(const void *context, int a, int b)
{
    const sb_vec3 *nodes = (const sb_vec3 *)context;
    if (nodes[a].x != nodes[b].x)
        return nodes[a].x < nodes[b].x;
    if (nodes[a].y != nodes[b].y)
        return nodes[a].y < nodes[b].y;
    return nodes[a].z < nodes[b].z;
}

/* Makes corners with equal coordinates one vertex, in the order they are met; vertex[i] is that of corner
 * i. `order` holds the sorted corners and serves as scratch. */
static void sbi_stl_weld(sbi_loader *loader, int *order, int *vertex)
{
    int corners = (int)loader->node_count, first = 0, used = 0;
    for (int i = 0; i < corners; i++) {
        if (i > 0 && sbi_stl_before(loader->nodes, order[i - 1], order[i]))
            first = i;
        vertex[order[i]] = order[first]; /* the sort is stable: the corner met first */
    }
    for (int i = 0; i < corners; i++) {
        if (vertex[i] == i) {
            loader->nodes[used] = loader->nodes[i];
            order[i] = used++;
        }
        vertex[i] = order[vertex[i]];
    }
    loader->node_count = (size_t)used;
    loader->merged_vertices = corners - used;
}

static sb_result sbi_stl_make_cells(sbi_loader *loader, const int *vertex, int facets)
{
    sb_result result = SB_OK;
    for (int i = 0; i < facets && !result; i++) {
        sbi_loader_begin_cell(loader);
        for (int k = 0; k < 3 && !result; k++)
            result = sbi_loader_cell_node(loader, vertex[3 * i + k], 0);
        if (!result)
            result = sbi_loader_end_polygon(loader, 0);
    }
    return result;
}

SBI_API sb_result sbi_stl_read(sbi_loader *loader)
{
    sbi_reader *reader = &loader->reader;
    const sb_allocator *allocator = &loader->allocator;
    sbi_word word;
    int *order, *vertex;
    int corners, binary = sbi_stl_is_binary(reader->data, reader->size);
    sb_result result;
    if (!binary)
        binary = !sbi_reader_peek(reader, &word) || !sbi_word_is(word, "solid");
    result = binary ? sbi_stl_binary(loader) : sbi_reader_check_text(reader);
    if (!result && !binary)
        result = sbi_stl_ascii(loader);
    if (result)
        return result;
    corners = (int)loader->node_count;
    order = (int *)sbi_alloc(allocator, (size_t)corners, sizeof(int));
    vertex = (int *)sbi_alloc(allocator, (size_t)corners, sizeof(int));
    if (order && vertex) {
        for (int i = 0; i < corners; i++)
            order[i] = i;
        sbi_merge_sort(order, vertex, corners, sbi_stl_before, loader->nodes);
        sbi_stl_weld(loader, order, vertex);
        result = sbi_stl_make_cells(loader, vertex, corners / 3);
    } else {
        result = sbi_loader_no_memory(loader);
    }
    sbi_free(allocator, order);
    sbi_free(allocator, vertex);
    return result;
}

/* ==== PLY ========================================================================================== */

typedef enum sbi_ply_role {
    SBI_PLY_OTHER = 0,
    SBI_PLY_X = 1,       /* y and z follow */
    SBI_PLY_CORNERS = 4, /* the list of a face */
    SBI_PLY_NX = 5       /* ny and nz follow */
} sbi_ply_role;

/* Class and size of a number: i signed, u unsigned, f floating. */
typedef struct sbi_ply_type {
    char name[2][8];
    char class_;
    int size;
} sbi_ply_type;

typedef struct sbi_ply_property {
    const sbi_ply_type *count; /* of a list; NULL: a single number */
    const sbi_ply_type *type;
    int role;
} sbi_ply_property;

typedef struct sbi_ply_element {
    int64_t rows;
    int is_vertex, is_face;
    size_t first, end; /* its properties */
} sbi_ply_element;

typedef struct sbi_ply {
    sbi_loader *loader;
    sbi_reader *reader;
    int ascii;
    sbi_ply_element *elements;
    size_t element_count, element_capacity;
    sbi_ply_property *properties;
    size_t property_count, property_capacity;
} sbi_ply;

static const sbi_ply_type *sbi_ply_find_type(sbi_word word)
{
    static const sbi_ply_type types[] = {{{"char", "int8"}, 'i', 1},     {{"uchar", "uint8"}, 'u', 1},
                                         {{"short", "int16"}, 'i', 2},   {{"ushort", "uint16"}, 'u', 2},
                                         {{"int", "int32"}, 'i', 4},     {{"uint", "uint32"}, 'u', 4},
                                         {{"float", "float32"}, 'f', 4}, {{"double", "float64"}, 'f', 8}};
    for (size_t i = 0; i < sizeof types / sizeof types[0]; i++)
        if (sbi_word_is(word, types[i].name[0]) || sbi_word_is(word, types[i].name[1]))
            return &types[i];
    return NULL;
}

/* The next word of the header line, which must be there; empty and a failure otherwise. */
static sb_result sbi_ply_word(sbi_ply *ply, sbi_word *word)
{
    word->text = "";
    word->length = 0;
    if (sbi_reader_line_word(ply->reader, word))
        return SB_OK;
    return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "an incomplete line in the PLY header");
}

static sb_result sbi_ply_read_type(sbi_ply *ply, const sbi_ply_type **type)
{
    sbi_word word;
    char text[32];
    sb_result result = sbi_ply_word(ply, &word);
    if (result)
        return result;
    *type = sbi_ply_find_type(word);
    if (!*type)
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "'%s' is not a PLY type", sbi_word_print(word, text));
    return SB_OK;
}

/* element NAME COUNT */
static sb_result sbi_ply_add_element(sbi_ply *ply)
{
    sbi_ply_element *element;
    sbi_word name;
    int64_t rows = 0;
    sb_result result = sbi_ply_word(ply, &name);
    if (!result)
        result = sbi_reader_integer(ply->reader, "the number of rows", &rows);
    if (!result && rows < 0)
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "a negative number of rows: %lld", (long long)rows);
    if (result)
        return result;
    if (ply->element_count == ply->element_capacity) {
        void *grown = sbi_loader_grow(ply->loader, ply->elements, ply->element_count, &ply->element_capacity,
                                      ply->element_count + 1, sizeof ply->elements[0]);
        if (!grown)
            return sbi_loader_no_memory(ply->loader);
        ply->elements = (sbi_ply_element *)grown;
    }
    element = &ply->elements[ply->element_count++];
    element->rows = rows;
    element->is_vertex = sbi_word_is(name, "vertex");
    element->is_face = sbi_word_is(name, "face");
    element->first = element->end = ply->property_count;
    return SB_OK;
}

static int sbi_ply_find_role(const sbi_ply *ply, const sbi_ply_property *property, sbi_word name)
{
    const sbi_ply_element *element = &ply->elements[ply->element_count - 1];
    int points_only = ply->loader->points_only;
    if (property->count) {
        int is_corners = sbi_word_is(name, "vertex_indices") || sbi_word_is(name, "vertex_index");
        return element->is_face && is_corners && !points_only ? SBI_PLY_CORNERS : SBI_PLY_OTHER;
    }
    if (element->is_vertex && points_only && name.length == 2 && name.text[0] == 'n' && name.text[1] >= 'x' &&
        name.text[1] <= 'z')
        return SBI_PLY_NX + (name.text[1] - 'x');
    if (!element->is_vertex || name.length != 1 || name.text[0] < 'x' || name.text[0] > 'z')
        return SBI_PLY_OTHER;
    return SBI_PLY_X + (name.text[0] - 'x');
}

/* property TYPE NAME, or property list COUNTTYPE TYPE NAME */
static sb_result sbi_ply_add_property(sbi_ply *ply)
{
    sbi_ply_property property = {NULL, NULL, SBI_PLY_OTHER};
    sbi_word name;
    sbi_reader ahead = *ply->reader;
    sb_result result = SB_OK;
    if (ply->element_count == 0)
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "a property before the first element");
    if (sbi_reader_line_word(&ahead, &name) && sbi_word_is(name, "list")) {
        *ply->reader = ahead;
        result = sbi_ply_read_type(ply, &property.count);
    }
    if (!result)
        result = sbi_ply_read_type(ply, &property.type);
    if (!result)
        result = sbi_ply_word(ply, &name);
    if (!result && property.count && property.count->class_ == 'f')
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "a list whose count is not an integer");
    if (result)
        return result;
    property.role = sbi_ply_find_role(ply, &property, name);
    if (ply->property_count == ply->property_capacity) {
        void *grown = sbi_loader_grow(ply->loader, ply->properties, ply->property_count, &ply->property_capacity,
                                      ply->property_count + 1, sizeof ply->properties[0]);
        if (!grown)
            return sbi_loader_no_memory(ply->loader);
        ply->properties = (sbi_ply_property *)grown;
    }
    ply->properties[ply->property_count++] = property;
    ply->elements[ply->element_count - 1].end = ply->property_count;
    return SB_OK;
}

/* format ascii|binary_little_endian|binary_big_endian 1.0 */
static sb_result sbi_ply_format(sbi_ply *ply, int *binary)
{
    sbi_word word;
    char text[32];
    sb_result result = sbi_ply_word(ply, &word);
    if (result)
        return result;
    ply->ascii = sbi_word_is(word, "ascii");
    ply->reader->big_endian = sbi_word_is(word, "binary_big_endian");
    *binary = !ply->ascii;
    if (*binary && !ply->reader->big_endian && !sbi_word_is(word, "binary_little_endian"))
        return sbi_reader_fail(ply->reader, SB_ERROR_UNSUPPORTED, "PLY format %s", sbi_word_print(word, text));
    return SB_OK;
}

static sb_result sbi_ply_header(sbi_ply *ply)
{
    sbi_word word;
    char text[32];
    int binary = -1;
    sb_result result = sbi_surface_expect(ply->reader, "ply");
    while (!result) {
        sbi_reader_next_line(ply->reader);
        if (!sbi_reader_word(ply->reader, &word))
            return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "the file ends in the PLY header");
        if (sbi_word_is(word, "end_header"))
            break;
        if (sbi_word_is(word, "format"))
            result = sbi_ply_format(ply, &binary);
        else if (sbi_word_is(word, "element"))
            result = sbi_ply_add_element(ply);
        else if (sbi_word_is(word, "property"))
            result = sbi_ply_add_property(ply);
        else if (!sbi_word_is(word, "comment") && !sbi_word_is(word, "obj_info"))
            return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "'%s' in the PLY header", sbi_word_print(word, text));
    }
    if (!result && binary < 0)
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "the PLY header does not state the format");
    sbi_reader_next_line(ply->reader);
    ply->reader->binary = binary > 0;
    return result || binary > 0 ? result : sbi_reader_check_text(ply->reader);
}

static sb_result sbi_ply_real(sbi_ply *ply, const sbi_ply_type *type, const char *what, double *value)
{
    const unsigned char *bytes;
    if (ply->ascii)
        return sbi_reader_real(ply->reader, what, value);
    bytes = sbi_reader_bytes(ply->reader, 1, (size_t)type->size, what);
    if (!bytes)
        return SB_ERROR_FORMAT;
    if (type->class_ == 'f')
        *value = sbi_decode_float(ply->reader, bytes, type->size);
    else if (type->class_ == 'i')
        *value = (double)sbi_decode_signed(ply->reader, bytes, type->size);
    else
        *value = (double)sbi_decode_bits(ply->reader, bytes, type->size);
    return SB_OK;
}

static sb_result sbi_ply_integer(sbi_ply *ply, const sbi_ply_type *type, const char *what, int64_t *value)
{
    double real = 0;
    sb_result result;
    if (ply->ascii)
        return sbi_reader_integer(ply->reader, what, value);
    result = sbi_ply_real(ply, type, what, &real);
    if (!result && !(real >= INT_MIN && real <= 4294967295.0 && real == (double)(int64_t)real))
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "%s is not an integer: %g", what, real);
    *value = (int64_t)real;
    return result;
}

/* A list that is not a face's, or a single number that is not a coordinate. */
static sb_result sbi_ply_skip(sbi_ply *ply, const sbi_ply_property *property, int64_t count)
{
    if ((uint64_t)count > sbi_reader_left(ply->reader))
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "the file is too short for a list of %lld",
                               (long long)count);
    if (ply->ascii)
        return sbi_reader_skip_words(ply->reader, (size_t)count, "a PLY row");
    return sbi_reader_bytes(ply->reader, (size_t)count, (size_t)property->type->size, "a PLY row") ? SB_OK
                                                                                                   : SB_ERROR_FORMAT;
}

static sb_result sbi_ply_list(sbi_ply *ply, const sbi_ply_property *property)
{
    int64_t count = 0, corner = 0;
    sb_result result = sbi_ply_integer(ply, property->count, "the length of a list", &count);
    if (!result && count < 0)
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "a list of negative length: %lld", (long long)count);
    if (result || property->role != SBI_PLY_CORNERS)
        return result ? result : sbi_ply_skip(ply, property, count);
    sbi_loader_begin_cell(ply->loader);
    for (int64_t i = 0; i < count && !result; i++) {
        result = sbi_ply_integer(ply, property->type, "vertex index", &corner);
        if (!result)
            result = sbi_loader_cell_node(ply->loader, corner, 0);
    }
    return result ? result : sbi_loader_end_polygon(ply->loader, 0);
}

static sb_result sbi_ply_row(sbi_ply *ply, const sbi_ply_element *element, int with_normal)
{
    double x[8] = {0, 0, 0, 0, 0, 0, 0, 0}; /* by role */
    sb_result result = SB_OK;
    for (size_t i = element->first; i < element->end && !result; i++) {
        const sbi_ply_property *property = &ply->properties[i];
        if (property->count)
            result = sbi_ply_list(ply, property);
        else if (property->role == SBI_PLY_OTHER)
            result = sbi_ply_skip(ply, property, 1);
        else
            result = sbi_ply_real(ply, property->type, "coordinate", &x[property->role]);
    }
    if (!result && element->is_vertex)
        result = sbi_loader_add_node(ply->loader, x + SBI_PLY_X);
    return result || !with_normal ? result : sbi_loader_add_normal(ply->loader, x + SBI_PLY_NX);
}

/* Bytes a row takes at least, and in *roles the roles that its properties have, as bits. */
static size_t sbi_ply_row_bytes(const sbi_ply *ply, const sbi_ply_element *element, unsigned *roles)
{
    size_t bytes = 0;
    *roles = 0;
    for (size_t i = element->first; i < element->end; i++) {
        const sbi_ply_property *property = &ply->properties[i];
        bytes += ply->ascii ? 2 : (size_t)(property->count ? property->count->size : property->type->size);
        *roles |= 1u << property->role;
    }
    return bytes;
}

static sb_result sbi_ply_rows(sbi_ply *ply, const sbi_ply_element *element)
{
    unsigned roles = 0;
    int rows = 0;
    size_t bytes = sbi_ply_row_bytes(ply, element, &roles);
    sb_result result;
    if (element->is_vertex && (roles & 0xEu) != 0xEu)
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "vertices without x, y and z");
    if (element->is_face && !ply->loader->points_only && !(roles & 1u << SBI_PLY_CORNERS))
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "faces without vertex_indices");
    if (bytes == 0)
        return SB_OK; /* rows of nothing */
    result = sbi_reader_check_count(ply->reader, "the number of rows", element->rows, bytes, &rows);
    if (!result && element->is_vertex)
        result = sbi_loader_reserve_nodes(ply->loader, rows);
    for (int i = 0; i < rows && !result; i++) {
        ply->reader->node = element->is_vertex ? (int)ply->loader->node_count : -1;
        ply->reader->element = element->is_face ? i : -1;
        result = sbi_ply_row(ply, element, (roles & 0xE0u) == 0xE0u);
    }
    ply->reader->node = ply->reader->element = -1;
    return result;
}

SBI_API sb_result sbi_ply_read(sbi_loader *loader)
{
    sbi_ply ply;
    sbi_word word;
    sb_result result;
    memset(&ply, 0, sizeof ply);
    ply.loader = loader;
    ply.reader = &loader->reader;
    result = sbi_ply_header(&ply);
    for (size_t i = 0; i < ply.element_count && !result; i++)
        result = sbi_ply_rows(&ply, &ply.elements[i]);
    if (!result && sbi_reader_word(ply.reader, &word))
        result = sbi_reader_fail(ply.reader, SB_ERROR_FORMAT, "the file goes on behind the last row");
    sbi_free(&loader->allocator, ply.elements);
    sbi_free(&loader->allocator, ply.properties);
    return result;
}

/* ==== OFF ========================================================================================== */

/* [ST][C][N]OFF: texture, colours and normals follow the place of a vertex on its line. *extras: whether
 * they do. */
static sb_result sbi_off_keyword(sbi_reader *reader, int *extras)
{
    static const char prefixes[3][3] = {"ST", "C", "N"};
    sbi_word word, rest;
    char text[32];
    if (!sbi_reader_word(reader, &word))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file is empty");
    rest = word;
    for (int i = 0; i < 3; i++) {
        size_t length = strlen(prefixes[i]);
        if (rest.length > length && memcmp(rest.text, prefixes[i], length) == 0) {
            rest.text += length;
            rest.length -= length;
        }
    }
    *extras = rest.length != word.length;
    if (rest.length == 3 && memcmp(rest.text, "OFF", 3) == 0)
        return SB_OK;
    if (word.length > 3 && memcmp(word.text + word.length - 3, "OFF", 3) == 0)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "%s is not supported: OFF of three coordinates is",
                               sbi_word_print(word, text));
    return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s' instead of OFF", sbi_word_print(word, text));
}

/* The rest of the line must be empty, or with `extras` numbers. */
static sb_result sbi_off_end_row(sbi_reader *reader, int extras)
{
    sbi_word word;
    char text[32];
    double value;
    while (sbi_reader_line_word(reader, &word))
        if (!extras || sbi_parse_real(word.text, word.length, &value) == 0)
            return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s' where the line should end",
                                   sbi_word_print(word, text));
    return SB_OK;
}

/* Number of corners, the corners, perhaps a colour. Points and edges are stepped over. */
static sb_result sbi_off_face(sbi_loader *loader)
{
    sbi_reader *reader = &loader->reader;
    int64_t vertex = 0;
    int corners = 0;
    sb_result result;
    sbi_loader_begin_cell(loader);
    result = sbi_reader_count(reader, "the number of corners", 2, &corners);
    for (int i = 0; i < corners && !result; i++) {
        result = sbi_reader_integer(reader, "vertex index", &vertex);
        if (!result)
            result = sbi_loader_cell_node(loader, vertex, 0);
    }
    if (!result)
        result = sbi_off_end_row(reader, 1);
    if (!result && (corners == 1 || corners == 2))
        return sbi_loader_end_cell(loader, sbi_cell_kind_of_vtk(corners == 1 ? 1 : 3), SBI_ORDER_SAME, 0);
    return result ? result : sbi_loader_end_polygon(loader, 0);
}

SBI_API sb_result sbi_off_read(sbi_loader *loader)
{
    sbi_reader *reader = &loader->reader;
    int counts[3] = {0, 0, 0}, extras = 0;
    sbi_word word;
    char text[32];
    sb_result result;
    reader->comment = '#';
    result = sbi_off_keyword(reader, &extras);
    if (!result && sbi_reader_peek(reader, &word) && sbi_word_is(word, "BINARY"))
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "binary OFF files are not supported");
    if (!result)
        result = sbi_reader_check_text(reader);
    if (!result)
        result = sbi_reader_count(reader, "the number of vertices", 6, &counts[0]);
    if (!result)
        result = sbi_reader_count(reader, "the number of faces", 4, &counts[1]);
    if (!result && !sbi_reader_at_line_end(reader)) /* of no use, and not always there */
        result = sbi_reader_count(reader, "the number of edges", 0, &counts[2]);
    if (!result)
        result = sbi_loader_reserve_nodes(loader, counts[0]);
    for (int i = 0; i < counts[0] && !result; i++) {
        result = sbi_loader_read_node(loader);
        if (!result)
            result = sbi_off_end_row(reader, extras);
    }
    for (int i = 0; i < counts[1] && !result; i++)
        result = sbi_off_face(loader);
    if (!result && sbi_reader_word(reader, &word))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s' behind the last face", sbi_word_print(word, text));
    return result;
}
