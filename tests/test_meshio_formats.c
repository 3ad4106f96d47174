/* Files that real people have: VTU in every encoding, gmsh 1 to 4.1, Medit, meshes of several kinds of cells, and what
 * a load reports. The files are built here, byte by byte, from the descriptions of the formats. */
#include "softbody.h"

#include "check.h"
#include "mesh_file.h"

#include <limits.h>
#include <time.h>

static sb_result load(const bytes *f, sb_mesh *mesh, sb_mesh_sets *sets, sb_load_report *report, sb_error *error)
{
    sb_load_options options = sb_default_load_options();
    options.sets = sets;
    options.report = report;
    memset(mesh, 0, sizeof *mesh);
    memset(error, 0, sizeof *error);
    return sb_mesh_load_memory(mesh, f->data, f->size, SB_FILE_AUTO, "built", &options, error);
}

static sb_result load_text(const char *text, sb_mesh *mesh, sb_mesh_sets *sets, sb_load_report *report, sb_error *error)
{
    bytes f = {NULL, 0, 0, 0};
    sb_result result;
    put_text(&f, text);
    result = load(&f, mesh, sets, report, error);
    bytes_free(&f);
    return result;
}

static int has_note(const sb_load_report *report, const char *words)
{
    for (int i = 0; i < report->note_count; i++)
        if (strstr(report->notes[i], words))
            return 1;
    return 0;
}

/* ---- the mesh of the built files: two tets and, as lower cells, a triangle and a point ------------- */

static const int triangle[3] = {0, 2, 1};

/* ---- gmsh ----------------------------------------------------------------------------------------- */

/* Node tags 10, 20, ...; groups: volumes 3 "outer part" and 7 (no name), surface 9 "in let". The second tet's entity is
 * in the groups 7 and 8. */
static void put_gmsh_nodes(bytes *f, int version, int binary)
{
    put_text(f, version == 1 ? "$NOD\n" : "$Nodes\n");
    if (version == 4) {
        put_integer(f, binary, 1, 8);
        put_integer(f, binary, 5, 8);
        put_integer(f, binary, 1, 4);
        put_integer(f, binary, 3, 4);
        put_integer(f, binary, 0, 4);
        put_integer(f, binary, 5, 8);
    } else {
        put_text(f, "5\n");
    }
    for (int i = 0; i < 5; i++) {
        put_integer(f, binary, 10 * (i + 1), 4);
        for (int k = 0; k < 3; k++)
            put_double(f, binary, pair_nodes[i][k]);
        if (version == 3 && i == 2) { /* a node on a face, with two parameters */
            put_integer(f, binary, 1, 4);
            put_integer(f, binary, 2, 4);
            put_double(f, binary, 0.5);
            put_double(f, binary, 0.25);
        } else if (version == 3) {
            put_integer(f, binary, 0, 4);
        }
    }
    put_text(f, version == 1 ? "\n$ENDNOD\n" : "\n$EndNodes\n");
}

static void put_gmsh_tags(bytes *f, int binary, const int *cell, int count)
{
    for (int k = 0; k < count; k++)
        put_integer(f, binary, 10 * (cell[k] + 1), 4);
}

/* The triangle and the tets, one element after the other. */
static void put_gmsh_elements(bytes *f, int version, int binary)
{
    put_text(f, version == 1 ? "$ELM\n3\n" : "$Elements\n");
    if (version == 4) {
        put_integer(f, binary, 3, 8);
        put_integer(f, binary, 3, 8);
    } else if (version == 3) {
        put_text(f, "3\n");
    }
    for (int i = 0; i < 3; i++) {
        int corners = i ? 4 : 3, type = i ? 4 : 2, entity = i == 2 ? 2 : 1;
        if (version == 4) {
            put_integer(f, binary, entity, 4);
            put_integer(f, binary, corners - 1, 4);
            put_integer(f, binary, type, 4);
            put_integer(f, binary, 1, 8);
        }
        put_integer(f, binary, 100 + i, 4);
        if (version != 4)
            put_integer(f, binary, type, 4);
        if (version == 1)
            put_integer(f, binary, i ? pair_regions[i - 1] : 9, 4);
        if (version != 4) {
            put_integer(f, binary, entity, 4);
            put_integer(f, binary, corners, 4);
        }
        put_gmsh_tags(f, binary, i ? pair_cells[i - 1] : triangle, corners);
    }
    put_text(f, version == 1 ? "\n$ENDELM\n" : "\n$EndElements\n");
}

static void put_gmsh_names(bytes *f)
{
    put_text(f, "$PhysicalNames\n2\n2 9 \"in let\"\n3 3 \"outer part\"\n$EndPhysicalNames\n");
}

/* Volume 1 is in the group 3, volume 2 in 7 and 8, surface 1 in -9: gmsh's sign of a reversed surface. */
static void put_gmsh_entities(bytes *f, int version, int binary)
{
    static const int groups[3][2] = {{-9, 0}, {3, 0}, {7, 8}};
    if (version == 3) {
        put_text(f, "$Entities\n0 0 1 2\n1 2 5 -6 1 -9\n1 0 1 3\n2 1 1 4 7 8 7 7\n$EndEntities\n");
        return;
    }
    put_text(f, "$Entities\n");
    for (int i = 0; i < 4; i++)
        put_integer(f, binary, i < 2 ? 0 : i - 1, 8);
    for (int i = 0; i < 3; i++) {
        int count = i == 2 ? 2 : 1;
        put_integer(f, binary, i == 2 ? 2 : 1, 4);
        for (int k = 0; k < 6; k++)
            put_double(f, binary, k < 3 ? 0 : 1);
        put_integer(f, binary, count, 8);
        for (int k = 0; k < count; k++)
            put_integer(f, binary, groups[i][k], 4);
        put_integer(f, binary, 1, 8);
        put_integer(f, binary, 1, 4);
    }
    put_text(f, "\n$EndEntities\n");
}

static void build_gmsh(bytes *f, int version, int binary, int big_endian)
{
    char line[40];
    f->big_endian = big_endian;
    if (version > 1) {
        snprintf(line, sizeof line, "$MeshFormat\n%d%s %d 8\n", version, version == 4 && !binary ? ".0" : "", binary);
        put_text(f, line);
        if (binary) {
            put_bits(f, 1, 4);
            put_text(f, "\n");
        }
        put_text(f, "$EndMeshFormat\n");
        put_gmsh_names(f);
        put_gmsh_entities(f, version, binary);
    }
    put_gmsh_nodes(f, version, binary);
    put_gmsh_elements(f, version, binary);
}

static void check_gmsh_sets(const sb_mesh_sets *sets, int version)
{
    const sb_mesh_set *inlet = sb_mesh_sets_find(sets, "in let", 2), *outer = sb_mesh_sets_find(sets, "outer part", -1);
    CHECK_INT(sets->count, version == 1 ? 3 : 4);
    if (version > 1 && CHECK(inlet != NULL) && CHECK(outer != NULL)) {
        CHECK(inlet->number == 9 && inlet->element_count == 0 && inlet->face_count == 1 && inlet->face_corners == 3);
        CHECK(memcmp(inlet->faces, triangle, sizeof triangle) == 0);
        CHECK(inlet->node_count == 3 && inlet->nodes[0] == 0 && inlet->nodes[1] == 1 && inlet->nodes[2] == 2);
        CHECK(outer->number == 3 && outer->dimension == 3 && outer->element_count == 1 && outer->elements[0] == 0);
        CHECK(outer->node_count == 4 && outer->faces == NULL);
    }
    CHECK(sb_mesh_sets_find(sets, "in let", 3) == NULL && sb_mesh_sets_find(sets, "let", -1) == NULL);
    if (version > 1 && sets->count == 4) { /* the second tet is in two groups */
        CHECK(sets->sets[2].number == 7 && sets->sets[3].number == 8 && !sets->sets[3].name[0]);
        CHECK(sets->sets[2].elements[0] == 1 && sets->sets[3].elements[0] == 1);
        CHECK(sets->sets[2].element_count == 1 && sets->sets[2].node_count == 4); /* once, though listed three times */
    }
}

static void test_gmsh_versions(void)
{
    static const int versions[3] = {1, 3, 4};
    for (int i = 0; i < 9; i++) {
        int version = versions[i / 3], binary = i % 3 > 0;
        bytes f = {NULL, 0, 0, 0};
        sb_mesh mesh;
        sb_mesh_sets sets;
        sb_load_report report;
        sb_error error;
        if (version == 1 && binary)
            continue;
        build_gmsh(&f, version, binary, i % 3 == 2);
        if (CHECK_OK(load(&f, &mesh, &sets, &report, &error))) {
            expect_pair(&mesh);
            check_gmsh_sets(&sets, version);
            CHECK_INT(report.skipped_cells, 1);
            CHECK_INT(report.note_count, 0);
            sb_mesh_free(&mesh);
            sb_mesh_sets_free(&sets);
            CHECK(sets.count == 0 && sets.sets == NULL);
            CHECK_OK(load(&f, &mesh, NULL, &report, &error));
            CHECK(version == 1 || has_note(&report, "in let, outer part"));
            sb_mesh_free(&mesh);
        } else {
            printf("  version %d, binary %d, line %d: %s\n", version, binary, error.line, error.message);
        }
        bytes_free(&f);
    }
}

static const char *gmsh_names(const char *names)
{
    static char text[800];
    snprintf(text, sizeof text,
             "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n%s$EndPhysicalNames\n$Nodes\n4\n1 0 0 0\n2 1 0 0\n"
             "3 0 1 0\n4 0 0 1\n$EndNodes\n$Elements\n2\n1 15 2 5 1 4\n2 4 2 1 1 1 2 3 4\n$EndElements\n",
             names);
    return text;
}

/* Names of every form, of points too, without cells, very long, in UTF-8, and wrong ones. */
static void test_gmsh_names(void)
{
    static const char *const wrong[6] = {"1\n3 1 body\n",     "1\n3 1 \"body\n",          "2\n3 1 \"body\"\n",
                                         "1\n7 1 \"body\"\n", "1\n3 99999999999 \"b\"\n", "4000000000\n3 1 \"b\"\n"};
    sb_mesh mesh;
    sb_mesh_sets sets;
    sb_load_report report;
    sb_error error;
    const sb_mesh_set *set;
    char name[200], text[300];
    if (CHECK_OK(load_text(gmsh_names("4\n0 5 \"tip\"\n3 1 \"\"\n3 2 \"empty $End\"\n1 \"old\"\n"), &mesh, &sets,
                           &report, &error))) {
        set = sb_mesh_sets_find(&sets, "tip", 0);
        CHECK(set && set->node_count == 1 && set->nodes[0] == 3 && set->element_count == 0 && set->face_count == 0);
        set = sb_mesh_sets_find(&sets, "empty $End", 3);
        CHECK(set && set->node_count == 0 && set->element_count == 0);
        set = sb_mesh_sets_find(&sets, "", 3);
        CHECK(set && set->number == 1 && set->element_count == 1);
        sb_mesh_free(&mesh);
        sb_mesh_sets_free(&sets);
    }
    for (int shift = 0; shift < 3; shift++) { /* cut between characters of three bytes, wherever the limit falls */
        memset(name, 0, sizeof name);
        for (int i = 0; i < shift; i++)
            name[i] = 'a';
        for (int i = 0; i < 40; i++)
            memcpy(name + shift + 3 * i, "\xE2\x82\xAC", 3);
        snprintf(text, sizeof text, "1\n3 1 \"%s\"\n", name);
        if (CHECK_OK(load_text(gmsh_names(text), &mesh, &sets, &report, &error)) && CHECK(sets.count == 2)) {
            size_t length = strlen(sets.sets[1].name);
            CHECK(length < SB_MESH_SET_NAME && length > SB_MESH_SET_NAME - 5 && (length - (size_t)shift) % 3 == 0);
            CHECK(strncmp(sets.sets[1].name, name, length) == 0);
        }
        sb_mesh_free(&mesh);
        sb_mesh_sets_free(&sets);
    }
    for (int i = 0; i < 6; i++) {
        CHECK_RESULT(load_text(gmsh_names(wrong[i]), &mesh, &sets, &report, &error), SB_ERROR_FORMAT);
        CHECK(error.line >= 5 && error.line <= 7 && error.message[0]);
    }
}

/* ---- Medit ---------------------------------------------------------------------------------------- */

static void put_medit_section(bytes *f, int version, const char *name, int code, size_t row_bytes, int rows)
{
    if (!version) {
        put_text(f, name);
        put_text(f, "\n");
        put_integer(f, 0, rows, 4);
        return;
    }
    put_bits(f, (uint64_t)code, 4);
    put_bits(f, f->size + (version >= 3 ? 8u : 4u) + (version >= 4 ? 8u : 4u) + row_bytes * (size_t)rows,
             version >= 3 ? 8 : 4);
    put_bits(f, (uint64_t)rows, version >= 4 ? 8 : 4);
}

/* version 0: text. Required vertices lie between, to be stepped over. */
static void build_medit(bytes *f, int version, int big_endian)
{
    int binary = version > 0, word = version >= 4 ? 8 : 4, real = version == 1 ? 4 : 8;
    f->big_endian = big_endian;
    if (binary) {
        put_bits(f, 1, 4);
        put_bits(f, (uint64_t)version, 4);
        put_bits(f, 3, 4);
        put_bits(f, f->size + (version >= 3 ? 12u : 8u), version >= 3 ? 8 : 4);
        put_bits(f, 3, 4);
    } else {
        put_text(f, " # a comment\nMeshVersionFormatted 2\nDimension\n3\n");
    }
    put_medit_section(f, version, "Vertices", 4, 3 * (size_t)real + (size_t)word, 5);
    for (int i = 0; i < 5; i++) {
        for (int k = 0; k < 3; k++) {
            if (binary)
                put_real(f, pair_nodes[i][k], real);
            else
                put_double(f, 0, pair_nodes[i][k]);
        }
        put_integer(f, binary, i, word);
    }
    put_medit_section(f, version, "\nRequiredVertices", 15, (size_t)word, 2);
    put_integer(f, binary, 1, word);
    put_integer(f, binary, 2, word);
    put_medit_section(f, version, "\nTriangles", 6, 4 * (size_t)word, 1);
    for (int k = 0; k < 3; k++)
        put_integer(f, binary, triangle[k] + 1, word);
    put_integer(f, binary, 9, word);
    put_medit_section(f, version, "\nTetrahedra", 8, 5 * (size_t)word, 2);
    for (int i = 0; i < 2; i++) {
        for (int k = 0; k < 4; k++)
            put_integer(f, binary, pair_cells[i][k] + 1, word);
        put_integer(f, binary, pair_regions[i], word);
    }
    if (binary) {
        put_bits(f, 54, 4);
        put_bits(f, 0, version >= 3 ? 8 : 4);
    } else {
        put_text(f, "\nEnd\n");
    }
}

static void test_medit(void)
{
    for (int i = 0; i < 9; i++) {
        bytes f = {NULL, 0, 0, 0};
        sb_mesh mesh;
        sb_mesh_sets sets;
        sb_load_report report;
        sb_error error;
        build_medit(&f, (i + 1) / 2, i % 2);
        if (i == 0) { /* the comment before the first keyword: told by the name */
            sb_load_options options = sb_default_load_options();
            CHECK_OK(sb_mesh_load_memory(&mesh, f.data, f.size, SB_FILE_AUTO, "x.mesh", NULL, &error));
            sb_mesh_free(&mesh);
            options.scale = 2;
            CHECK_OK(sb_mesh_load_memory(&mesh, f.data, f.size, SB_FILE_MEDIT, NULL, &options, &error));
            CHECK(mesh.nodes && mesh.nodes[1].x == 2);
            sb_mesh_free(&mesh);
            memmove(f.data, strchr((char *)f.data, '\n'), f.size -= 12);
        }
        if (CHECK_OK(load(&f, &mesh, &sets, &report, &error))) {
            expect_pair(&mesh);
            CHECK_INT(report.format, SB_FILE_MEDIT);
            CHECK_INT(report.ignored, 2);
            CHECK(has_note(&report, i == 0 ? "RequiredVertices" : "keyword 15") && has_note(&report, "references"));
            CHECK(sets.count == 3 && sets.sets[0].dimension == 2 && sets.sets[0].number == 9);
            sb_mesh_free(&mesh);
            sb_mesh_sets_free(&sets);
        } else {
            printf("  version %d: %s\n", (i + 1) / 2, error.message);
        }
        bytes_free(&f);
    }
}

/* ---- VTU ------------------------------------------------------------------------------------------ */

enum { ASCII = 0, INLINE = 1, APPENDED_RAW = 2, APPENDED_BASE64 = 3 };
enum { PLAIN = 0, STORED = 1, FIXED = 2 }; /* packed how */

typedef struct vtu {
    bytes f, appended;
    int format, packing, header, big_endian;
    size_t block; /* bytes */
    int apart;    /* header and data encoded one by one, without packing too */
} vtu;

static void put_base64(bytes *f, const unsigned char *data, size_t size)
{
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    for (size_t i = 0; i < size; i += 3) {
        unsigned group = (unsigned)data[i] << 16 | (i + 1 < size ? (unsigned)data[i + 1] << 8 : 0u) |
                         (i + 2 < size ? (unsigned)data[i + 2] : 0u);
        char text[4];
        for (int k = 0; k < 4; k++)
            text[k] = digits[group >> (18 - 6 * k) & 63];
        if (i + 2 >= size)
            text[3] = '=';
        if (i + 1 >= size)
            text[2] = '=';
        put(f, text, 4);
    }
}

/* Bits of a deflate stream, lowest first. */
typedef struct bit_writer {
    bytes *f;
    unsigned hold;
    int count;
} bit_writer;

static void put_bit(bit_writer *w, unsigned bit)
{
    unsigned char byte;
    w->hold |= (bit & 1u) << w->count++;
    if (w->count < 8)
        return;
    byte = (unsigned char)w->hold;
    put(w->f, &byte, 1);
    w->hold = 0;
    w->count = 0;
}

static void put_code(bit_writer *w, unsigned code, int length)
{
    for (int i = length - 1; i >= 0; i--)
        put_bit(w, code >> i);
}

/* A symbol of the fixed code of RFC 1951. */
static void put_symbol(bit_writer *w, unsigned s)
{
    if (s < 144)
        put_code(w, 0x30 + s, 8);
    else if (s < 256)
        put_code(w, 0x190 + s - 144, 9);
    else if (s < 280)
        put_code(w, s - 256, 7);
    else
        put_code(w, 0xC0 + s - 280, 8);
}

/* Literals, and a run of four or more equal bytes as a copy of distance 1. */
static void put_fixed_block(bytes *f, const unsigned char *data, size_t size)
{
    bit_writer w;
    w.f = f;
    w.hold = 0;
    w.count = 0;
    put_bit(&w, 1);
    put_bit(&w, 1);
    put_bit(&w, 0);
    for (size_t i = 0; i < size;) {
        size_t run = 1;
        while (i + run < size && data[i + run] == data[i] && run < 11)
            run++;
        put_symbol(&w, data[i++]);
        if (run < 4)
            continue;
        put_symbol(&w, (unsigned)(257 + run - 1 - 3)); /* lengths 3 to 10 */
        put_code(&w, 0, 5);                            /* distance 1 */
        i += run - 1;
    }
    put_symbol(&w, 256);
    while (w.count)
        put_bit(&w, 0);
}

static void put_zlib(bytes *f, const unsigned char *data, size_t size, int packing)
{
    uint32_t a = 1, b = 0;
    int kept = f->big_endian;
    put(f, "\x78\x01", 2);
    f->big_endian = 0;
    if (packing == STORED) {
        put_bits(f, 1, 1);
        put_bits(f, size, 2);
        put_bits(f, ~size & 0xFFFF, 2);
        put(f, data, size);
    } else {
        put_fixed_block(f, data, size);
    }
    for (size_t i = 0; i < size; i++) {
        a = (a + data[i]) % 65521;
        b = (b + a) % 65521;
    }
    f->big_endian = 1;
    put_bits(f, b << 16 | a, 4);
    f->big_endian = kept;
}

/* Header and data as they stand in the file before they are encoded; *head: bytes of the header. */
static void pack(const vtu *v, const bytes *values, bytes *out, size_t *head)
{
    bytes blocks = {NULL, 0, 0, 0};
    size_t count = (values->size + v->block - 1) / v->block;
    out->big_endian = v->big_endian;
    if (v->packing == PLAIN) {
        put_bits(out, values->size, v->header);
        *head = out->size;
        put(out, values->data, values->size);
        return;
    }
    put_bits(out, count, v->header);
    put_bits(out, v->block, v->header);
    put_bits(out, values->size % v->block, v->header);
    for (size_t i = 0; i < count; i++) {
        size_t left = values->size - i * v->block, before = blocks.size;
        put_zlib(&blocks, values->data + i * v->block, left < v->block ? left : v->block, v->packing);
        put_bits(out, blocks.size - before, v->header);
    }
    *head = out->size;
    put(out, blocks.data, blocks.size);
    bytes_free(&blocks);
}

static void put_encoded(bytes *to, const bytes *packed, size_t head, int apart)
{
    if (apart) {
        put_base64(to, packed->data, head);
        put_base64(to, packed->data + head, packed->size - head);
    } else {
        put_base64(to, packed->data, packed->size);
    }
}

/* A DataArray; type is VTK's, with the bits of a value at its end. */
static void put_array(vtu *v, const char *type, const char *name, int components, const double *values, int count)
{
    static const char *const formats[4] = {"ascii", "binary", "appended", "appended"};
    int width = atoi(strpbrk(type, "1368")) / 8, apart = v->apart || v->packing != PLAIN;
    bytes raw = {NULL, 0, 0, 0}, packed = {NULL, 0, 0, 0};
    char tag[200];
    size_t head = 0;
    snprintf(tag, sizeof tag, "<DataArray type='%s' Name=\"%s\" NumberOfComponents=\"%d\" format=\"%s\"", type, name,
             components, formats[v->format]);
    put_text(&v->f, tag);
    raw.big_endian = v->big_endian;
    for (int i = 0; i < count; i++) {
        if (type[0] == 'F')
            put_real(&raw, values[i], width);
        else
            put_bits(&raw, (uint64_t)(long long)values[i], width);
    }
    pack(v, &raw, &packed, &head);
    if (v->format >= APPENDED_RAW) {
        snprintf(tag, sizeof tag, " offset=\"%d\"/>\n", (int)v->appended.size);
        put_text(&v->f, tag);
        if (v->format == APPENDED_RAW)
            put(&v->appended, packed.data, packed.size);
        else
            put_encoded(&v->appended, &packed, head, apart);
    } else {
        put_text(&v->f, ">\n");
        for (int i = 0; i < count && v->format == ASCII; i++) {
            snprintf(tag, sizeof tag, i + 1 < count ? "%.17g " : "%.17g", values[i]);
            put_text(&v->f, tag);
        }
        if (v->format == INLINE)
            put_encoded(&v->f, &packed, head, apart);
        /* newer VTK puts information behind the values */
        put_text(&v->f, "<InformationKey name=\"L2\" location=\"vtkDataArray\">0</InformationKey></DataArray>\n");
    }
    bytes_free(&raw);
    bytes_free(&packed);
}

/* One piece: the tets [first, end), the triangle before them, and all nodes. */
static void put_piece(vtu *v, const char *reals, const char *integers, int first, int end)
{
    double values[40];
    char tag[100];
    int count = 0, cells = 1 + end - first;
    snprintf(tag, sizeof tag, "<Piece NumberOfPoints=\"5\" NumberOfCells=\"%d\">\n<PointData>\n", cells);
    put_text(&v->f, tag);
    for (int i = 0; i < 5; i++)
        values[i] = i;
    put_array(v, "Float32", "heat", 1, values, 5);
    put_text(&v->f, "</PointData>\n<CellData Scalars=\"material\">\n");
    for (int i = 0; i < cells; i++)
        values[i] = i == 0 ? 9 : pair_regions[first + i - 1];
    put_array(v, "Int16", "material", 1, values, cells);
    put_array(v, "Float64", "quality", 1, values, cells);
    put_text(&v->f, "</CellData>\n<Points>\n");
    for (int i = 0; i < 15; i++)
        values[i] = pair_nodes[i / 3][i % 3];
    put_array(v, reals, "Points", 3, values, 15);
    put_text(&v->f, "</Points>\n<Cells>\n");
    for (int k = 0; k < 3; k++)
        values[count++] = triangle[k];
    for (int i = first; i < end; i++)
        for (int k = 0; k < 4; k++)
            values[count++] = pair_cells[i][k];
    put_array(v, integers, "connectivity", 1, values, count);
    for (int i = 0; i < cells; i++)
        values[i] = 3 + 4 * i;
    put_array(v, integers, "offsets", 1, values, cells);
    for (int i = 0; i < cells; i++)
        values[i] = i ? 10 : 5;
    put_array(v, "UInt8", "types", 1, values, cells);
    put_text(&v->f, "</Cells>\n</Piece>\n");
}

static void begin_vtu(vtu *v, const char *type)
{
    char tag[300];
    snprintf(
        tag, sizeof tag,
        "<?xml version=\"1.0\"?>\n<!-- <VTKFile> is below -->\n<VTKFile type=\"%s\" version=\"1.0\" byte_order=\"%s\" "
        "header_type=\"UInt%d\"%s>\n<%s>\n",
        type, v->big_endian ? "BigEndian" : "LittleEndian", 8 * v->header,
        v->packing == PLAIN ? "" : " compressor=\"vtkZLibDataCompressor\"", type);
    put_text(&v->f, tag);
}

static void end_vtu(vtu *v, const char *type)
{
    put_text(&v->f, "</");
    put_text(&v->f, type);
    put_text(&v->f, ">\n");
    if (v->format >= APPENDED_RAW) {
        put_text(&v->f, v->format == APPENDED_RAW ? "<AppendedData encoding=\"raw\">\n   _"
                                                  : "<AppendedData encoding=\"base64\">\n   _");
        put(&v->f, v->appended.data, v->appended.size);
        put_text(&v->f, "\n</AppendedData>\n");
    }
    put_text(&v->f, "</VTKFile>\n");
    bytes_free(&v->appended);
}

/* All encodings: format, packing, header, byte order, types. `i` in [0, VTU_CASES). */
enum { VTU_CASES = 96 };
static void build_vtu(bytes *f, int i)
{
    static const char *const reals[3] = {"Float32", "Float64", "Float64"};
    static const char *const integers[3] = {"Int32", "Int64", "UInt8"};
    vtu v;
    memset(&v, 0, sizeof v);
    v.format = i % 4;
    v.header = i / 4 % 2 ? 8 : 4;
    v.big_endian = i / 8 % 2;
    v.packing = i / 16 % 3;
    v.block = i / 48 % 2 ? 40 : 4096; /* a row of blocks, or one */
    v.apart = i / 48 % 2;
    begin_vtu(&v, "UnstructuredGrid");
    put_piece(&v, reals[i % 3], integers[i / 4 % 3], 0, 2);
    end_vtu(&v, "UnstructuredGrid");
    *f = v.f;
}

static void test_vtu_encodings(void)
{
    for (int i = 0; i < VTU_CASES; i++) {
        bytes f;
        sb_mesh mesh;
        sb_mesh_sets sets;
        sb_load_report report;
        sb_error error;
        int failures = check.failures;
        build_vtu(&f, i);
        if (CHECK_OK(load(&f, &mesh, &sets, &report, &error))) {
            expect_pair(&mesh);
            CHECK_INT(report.format, SB_FILE_VTU);
            CHECK_INT(report.file_cells, 3);
            CHECK_INT(report.ignored, 2);
            CHECK(has_note(&report, "heat, quality") && has_note(&report, "regions are the cell field material"));
            CHECK(sets.count == 3 && sets.sets[0].number == 9 && sets.sets[0].face_count == 1);
            sb_mesh_free(&mesh);
            sb_mesh_sets_free(&sets);
        } else {
            printf("  line %d: %s\n", error.line, error.message);
        }
        if (check.failures != failures)
            printf("  in case %d\n", i);
        bytes_free(&f);
    }
}

/* Pieces are joined as they are; the second one's nodes follow. */
static void test_vtu_pieces(void)
{
    for (int format = ASCII; format <= APPENDED_BASE64; format++) {
        vtu v;
        sb_mesh mesh;
        sb_mesh_sets sets;
        sb_load_report report;
        sb_error error;
        memset(&v, 0, sizeof v);
        v.format = format;
        v.header = 4;
        v.block = 4096;
        begin_vtu(&v, "UnstructuredGrid");
        put_piece(&v, "Float64", "Int64", 0, 1);
        put_text(&v.f, "<Piece NumberOfPoints=\"0\" NumberOfCells=\"0\"><Points/><Cells/></Piece>\n");
        put_piece(&v, "Float32", "Int32", 1, 2);
        end_vtu(&v, "UnstructuredGrid");
        if (CHECK_OK(load(&v.f, &mesh, &sets, &report, &error))) {
            CHECK_INT(mesh.node_count, 10);
            CHECK_INT(mesh.element_count, 2);
            CHECK(mesh.elements[4] == 6 && mesh.elements[7] == 9 && mesh.regions && mesh.regions[1] == 7);
            CHECK_INT(report.ignored, 2);
            CHECK(has_note(&report, "2 pieces"));
            sb_mesh_free(&mesh);
            sb_mesh_sets_free(&sets);
        } else {
            printf("  line %d: %s\n", error.line, error.message);
        }
        bytes_free(&v.f);
    }
}

/* Verts, lines, strips and polygons; data of cells counts them in VTK's order. */
static void test_vtp(void)
{
    static const char text[] =
        "<VTKFile type='PolyData' version='0.1'><PolyData>\n"
        "<Piece NumberOfPoints='8' NumberOfVerts='1' NumberOfLines='1' NumberOfStrips='1' NumberOfPolys='2'>\n"
        "<CellData><DataArray type='Int32' Name='RegionId'>5 6 1 2 3</DataArray></CellData>\n"
        "<Points><DataArray type='Float32' NumberOfComponents='3' format='ascii'>\n"
        "0 0 0 1 0 0 0 1 0 1 1 0 0 0 1 1 0 1 0 1 1 1 1 1</DataArray></Points>\n"
        "<Verts><DataArray type='Int32' Name='connectivity'>7</DataArray><DataArray type='Int32' Name='offsets'>1"
        "</DataArray></Verts>\n"
        "<Lines><DataArray type='Int32' Name='connectivity'>0 7</DataArray><DataArray type='Int32' Name='offsets'>2"
        "</DataArray></Lines>\n"
        "<Strips><DataArray type='Int32' Name='connectivity'>0 4 2 6 3 7 1 5 0 4</DataArray>"
        "<DataArray type='Int32' Name='offsets'>10</DataArray></Strips>\n"
        "<Polys><DataArray type='Int32' Name='connectivity'>0 2 3 1 4 5 7 6</DataArray>"
        "<DataArray type='Int32' Name='offsets'>4 8</DataArray></Polys></Piece></PolyData></VTKFile>\n";
    sb_mesh mesh;
    sb_mesh_sets sets;
    sb_load_report report;
    sb_error error;
    if (!CHECK_OK(load_text(text, &mesh, &sets, &report, &error))) {
        printf("  line %d: %s\n", error.line, error.message);
        return;
    }
    CHECK_INT(mesh.element_count, 12);
    CHECK_NEAR(sb_mesh_volume(&mesh), 1, 10 * SB_EPSILON);
    CHECK(mesh.regions && mesh.regions[0] == 1 && mesh.regions[2] == 2 && mesh.regions[4] == 3);
    CHECK_INT(report.skipped_cells, 2);
    sb_mesh_free(&mesh);
    sb_mesh_sets_free(&sets);
}

/* ---- compressed data ------------------------------------------------------------------------------ */

/* 180 triangles whose regions are the bytes that a stream of zlib's own making unpacks to, with a dynamic code. */
static const char zlib_text[] =
    "aaca\nf\neba\naefafcba aaaaebfabf\nbebbfdafabda fbdd\nea\nbefbeeafabee\na\nadebbbabbeeefcaeabfa\n"
    "ebf\nefea fabbbacaaaafacbcabedabbcbcdf \n\naade fbcacbfabaeaabffbfbae fadabadaaddbfcaaabfbaebea";
enum { ZLIB_TEXT = sizeof zlib_text - 1 };
static void build_packed(bytes *f, const unsigned char *stream, size_t size, unsigned claimed)
{
    bytes head = {NULL, 0, 0, 0};
    put_text(f, "<VTKFile type='PolyData' byte_order='LittleEndian' compressor='vtkZLibDataCompressor'><PolyData>\n"
                "<Piece NumberOfPoints='3' NumberOfPolys='180'>\n<CellData><DataArray type='UInt8' Name='material' "
                "format='binary'>\n");
    put_bits(&head, 1, 4);
    put_bits(&head, claimed, 4);
    put_bits(&head, 0, 4);
    put_bits(&head, size, 4);
    put_base64(f, head.data, head.size);
    put_base64(f, stream, size);
    put_text(f, "\n</DataArray></CellData>\n<Points><DataArray type='Float32' NumberOfComponents='3'>0 0 0 1 0 0 0 1 0"
                "</DataArray></Points>\n<Polys><DataArray type='Int32' Name='connectivity'>");
    for (int i = 0; i < ZLIB_TEXT; i++)
        put_text(f, "0 1 2\n");
    put_text(f, "</DataArray><DataArray type='Int32' Name='offsets'>");
    for (int i = 0; i < ZLIB_TEXT; i++)
        put_integer(f, 0, 3 * (i + 1), 4);
    put_text(f, "</DataArray></Polys></Piece></PolyData></VTKFile>\n");
    bytes_free(&head);
}

static int is_zlib_text(const sb_mesh *mesh)
{
    int same = mesh->element_count == ZLIB_TEXT && mesh->regions != NULL;
    for (int i = 0; i < ZLIB_TEXT && same; i++)
        same = mesh->regions[i] == zlib_text[i];
    return same;
}

static void test_inflate(void)
{
    static const unsigned char stream[] = {
        120, 218, 29,  140, 193, 13,  68,  81,  8,   2,   239, 86,  241, 91,  3,   133, 254, 75,  216, 121,
        107, 98,  130, 200, 32,  173, 166, 19,  107, 148, 170, 107, 125, 98,  226, 202, 29,  199, 238, 9,
        125, 250, 234, 187, 137, 48,  235, 228, 153, 201, 192, 29,  33,  203, 92,  233, 42,  112, 162, 144,
        210, 6,   72,  239, 185, 175, 179, 90,  47,  208, 97,  161, 174, 223, 140, 160, 41,  94,  94,  36,
        129, 161, 235, 162, 32,  9,   178, 186, 115, 95,  193, 223, 118, 244, 3,   31,  183, 63,  216};
    bytes f = {NULL, 0, 0, 0};
    sb_mesh mesh;
    sb_error error;
    int unseen = 0;
    /* as it is; then cut short at every byte; then with each bit changed: an error, or the same bytes where the bit
     * says nothing (window, level); then with a wrong size announced */
    for (size_t i = 0; i < 9 * sizeof stream + 3; i++) {
        unsigned char changed[sizeof stream];
        size_t size = i > 0 && i < sizeof stream ? i : sizeof stream, bit = i - sizeof stream;
        unsigned claimed = i == 9 * sizeof stream + 1 ? 179 : i == 9 * sizeof stream + 2 ? 181 : ZLIB_TEXT;
        sb_result result;
        memcpy(changed, stream, sizeof stream);
        if (i >= sizeof stream && bit < 8 * sizeof stream)
            changed[bit / 8] ^= (unsigned char)(1 << bit % 8);
        build_packed(&f, changed, size, claimed);
        result = load(&f, &mesh, NULL, NULL, &error);
        if (i == 0)
            CHECK_OK(result);
        if (result == SB_OK)
            CHECK(claimed == ZLIB_TEXT && size == sizeof stream);
        if (result == SB_OK)
            unseen += !is_zlib_text(&mesh);
        else
            CHECK(result == SB_ERROR_FORMAT && strstr(error.message, "unpacked") && error.line == 3);
        sb_mesh_free(&mesh);
        bytes_free(&f);
    }
    CHECK_INT(unseen, 1); /* three bytes change, the checksum does not: zlib unpacks that stream to the same */
}

/* ---- cells cut into tets -------------------------------------------------------------------------- */

/* A block of n x n x 3 cubes: wedges below, hexahedra above them, pyramids round a middle node on top. Nodes are
 * numbered at random, and moved a little. */
typedef struct block {
    int n;
    int grid[6][6][4], middle[5][5];
    int node_count;
    sb_vec3 nodes[260];
    double volume;
} block;

static void make_block(block *b, int n, double bend, unsigned long long *state)
{
    int order[260], side = n + 1;
    memset(b, 0, sizeof *b);
    b->n = n;
    b->node_count = side * side * 4 + n * n;
    for (int i = 0; i < b->node_count; i++)
        order[i] = i;
    for (int i = b->node_count - 1; i > 0; i--) {
        int k = (int)(check_random(state) * (i + 1)), hold = order[i];
        order[i] = order[k];
        order[k] = hold;
    }
    for (int i = 0, next = 0; i < side; i++)
        for (int j = 0; j < side; j++)
            for (int k = 0; k < 5; k++) {
                double x = i, y = j, z = k;
                if (k == 4 && (i == n || j == n))
                    continue;
                if (k == 4)
                    x += 0.5, y += 0.5, z = 2.5;
                b->nodes[order[next]] = sb_v3((sb_real)(x + bend * sin(2 * y + z)), (sb_real)(y + bend * sin(2 * z)),
                                              (sb_real)(z + bend * sin(x + y)));
                if (k == 4)
                    b->middle[i][j] = order[next++];
                else
                    b->grid[i][j][k] = order[next++];
            }
}

/* The corners of cube i j k in VTK's order. */
static void block_corners(const block *b, int i, int j, int k, int c[8])
{
    for (int a = 0; a < 8; a++)
        c[a] = b->grid[i + (a % 4 == 1 || a % 4 == 2)][j + (a % 4 > 1)][k + a / 4];
}

/* Cells of a cube as VTK types and corners; returns how many numbers were written: type, count, nodes ... */
static int block_cells(const block *b, int i, int j, int k, int mirrored, int *out)
{
    static const int wedges[2][6] = {{0, 4, 3, 1, 5, 2}, {4, 7, 3, 5, 6, 2}};
    static const int pyramids[6][4] = {{0, 1, 2, 3}, {4, 7, 6, 5}, {0, 4, 5, 1},
                                       {1, 5, 6, 2}, {2, 6, 7, 3}, {3, 7, 4, 0}};
    int c[8], used = 0;
    block_corners(b, i, j, k, c);
    for (int p = 0; p < 2 && k == 0; p++) {
        out[used++] = 13;
        out[used++] = 6;
        for (int a = 0; a < 6; a++)
            out[used++] = c[wedges[p][mirrored ? (a + 3) % 6 : a]];
    }
    if (k == 1) {
        out[used++] = 12;
        out[used++] = 8;
        for (int a = 0; a < 8; a++)
            out[used++] = c[a];
    }
    for (int p = 0; p < 6 && k == 2; p++) {
        out[used++] = 14;
        out[used++] = 5;
        for (int a = 0; a < 4; a++)
            out[used++] = c[pyramids[p][a]];
        out[used++] = b->middle[i][j];
    }
    return used;
}

static int block_has(const block *b, int k) { return b->n * b->n * (k == 0 ? 2 : k == 1 ? 1 : 6); }

static void put_block(bytes *f, const block *b, int mirrored)
{
    int cells = block_has(b, 0) + block_has(b, 1) + block_has(b, 2), out[64];
    int numbers = 7 * block_has(b, 0) + 9 * block_has(b, 1) + 6 * block_has(b, 2);
    char line[100];
    put_text(f, "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\n");
    snprintf(line, sizeof line, "POINTS %d double\n", b->node_count);
    put_text(f, line);
    for (int i = 0; i < b->node_count; i++) {
        snprintf(line, sizeof line, "%.17g %.17g %.17g\n", (double)b->nodes[i].x, (double)b->nodes[i].y,
                 (double)b->nodes[i].z);
        put_text(f, line);
    }
    for (int types = 0; types < 2; types++) {
        snprintf(line, sizeof line, types ? "CELL_TYPES %d\n" : "CELLS %d %d\n", cells, numbers);
        put_text(f, line);
        for (int i = 0; i < b->n; i++)
            for (int j = 0; j < b->n; j++)
                for (int k = 0; k < 3; k++)
                    for (int at = 0, used = block_cells(b, i, j, k, mirrored, out); at < used; at += 2 + out[at + 1])
                        for (int a = types ? 0 : 1; a < (types ? 1 : 2 + out[at + 1]); a++)
                            put_integer(f, 0, out[at + a], 4);
        put_text(f, "\n");
    }
}

/* Tets that fit: none inside out (or the load would fail), all of the volume, and only faces of the block's skin at its
 * skin. With mirrored wedges too. */
static void test_mixed_meshes(void)
{
    unsigned long long state = 7;
    for (int round = 0; round < 24; round++) {
        int n = 1 + round % 4, skin = 4 * n * n + 24 * n; /* triangles: bottom and top, 3 layers of 4 sides */
        double bend = round % 3 * 0.03;
        block b;
        bytes f = {NULL, 0, 0, 0};
        sb_mesh mesh;
        sb_mesh_report found;
        sb_load_report report;
        sb_error error;
        make_block(&b, n, bend, &state);
        put_block(&f, &b, round % 2);
        if (CHECK_OK(load(&f, &mesh, NULL, &report, &error))) {
            CHECK_INT(mesh.element_type, SB_TET4);
            CHECK_INT(mesh.element_count, n * n * (2 * 3 + 6 + 6 * 2));
            CHECK_INT(mesh.node_count, b.node_count);
            CHECK_INT(report.split_cells, n * n * 9);
            CHECK_INT(report.flipped_elements, round % 2 ? 0 : n * n * 6); /* VTK's own wedges are mirrored ones */
            CHECK(has_note(&report, "were cut into"));
            if (bend <= 0)
                CHECK_NEAR(sb_mesh_volume(&mesh), 3 * n * n, 200 * SB_EPSILON);
            if (CHECK_OK(sb_mesh_check(&mesh, NULL, &found, NULL))) {
                CHECK_INT(found.boundary_faces, skin);
                CHECK_INT(found.nonmanifold_faces, 0);
                CHECK_INT(found.components, 1);
                CHECK_INT(found.unreferenced_nodes, 0);
                sb_mesh_report_free(&found);
            }
            sb_mesh_free(&mesh);
        } else {
            printf("  round %d, element %d: %s\n", round, error.element, error.message);
        }
        bytes_free(&f);
    }
}

/* Regions and sets follow the tets of each cell; a quadrilateral of a group is cut as the cells are. */
static void test_mixed_sets(void)
{
    static const char text[] =
        "MeshVersionFormatted 2\nDimension 3\nVertices 9\n0 0 0 0\n1 0 0 0\n1 1 0 0\n0 1 0 0\n0 0 1 0\n1 0 1 0\n1 1 1 "
        "0\n"
        "0 1 1 0\n0.5 0.5 2 0\nQuadrilaterals 2\n8 7 6 5 4\n1 4 3 2 5\nHexahedra 1\n1 2 3 4 5 6 7 8 11\nPyramids 1\n"
        "5 6 7 8 9 12\nEnd\n";
    sb_mesh mesh;
    sb_mesh_sets sets;
    sb_load_report report;
    sb_error error;
    if (!CHECK_OK(load_text(text, &mesh, &sets, &report, &error)) || !CHECK_INT(mesh.element_count, 8) ||
        !CHECK_INT(sets.count, 4))
        return;
    for (int e = 0; e < 8; e++)
        CHECK_INT(mesh.regions[e], e < 6 ? 11 : 12);
    CHECK(sets.sets[2].element_count == 6 && sets.sets[2].node_count == 8 && sets.sets[3].element_count == 2 &&
          sets.sets[3].elements[0] == 6 && sets.sets[3].node_count == 5);
    for (int i = 0; i < 2; i++) {
        const sb_mesh_set *set = &sets.sets[i];
        CHECK(set->face_count == 2 && set->face_corners == 3 && set->node_count == 4 && set->dimension == 2);
        for (int k = 0; k < set->face_count; k++) { /* each is a face of a tet */
            int held = 0;
            for (int e = 0; e < 8; e++) {
                int met = 0;
                for (int a = 0; a < 12; a++)
                    met += mesh.elements[4 * e + a / 3] == set->faces[3 * k + a % 3];
                held += met == 3;
            }
            CHECK_INT(held, i == 0 ? 2 : 1);
        }
    }
    sb_mesh_free(&mesh);
    sb_mesh_sets_free(&sets);
}

/* The map that bends the quadratic block; its volume is that of the straight one. */
static sb_vec3 shear(double x, double y, double z)
{
    return sb_v3((sb_real)(x + 0.2 * z * z), (sb_real)(y + 0.1 * x * x), (sb_real)z);
}

/* A hex20 (or hex27) with a wedge15 (wedge18) beside it and a pyramid13 (pyramid14) on top, curved by a quadratic map:
 * tet10 that hold the map exactly. Nodes are made from VTK's lists of edges and faces. */
static int put_curved_cell(bytes *points, bytes *cells, int *node_count, sb_vec3 *list, const double corners[][3],
                           int corner_count, const signed char (*edges)[2], int edge_count,
                           const signed char (*faces)[4], int face_count, int with_centre)
{
    int count = corner_count + edge_count + face_count + with_centre;
    char line[100];
    put_integer(cells, 0, count, 4);
    for (int i = 0; i < count; i++) {
        double x[3] = {0, 0, 0};
        const signed char *of = i < corner_count + edge_count ? (i < corner_count ? NULL : edges[i - corner_count])
                                                              : faces[i - corner_count - edge_count];
        int parts = i < corner_count                ? 1
                    : i < corner_count + edge_count ? 2
                    : i < count - with_centre       ? 4
                                                    : corner_count;
        int node = 0;
        sb_vec3 at;
        for (int k = 0; k < parts * 3; k++)
            x[k % 3] += corners[i < corner_count ? i : parts == corner_count ? k / 3 : of[k / 3]][k % 3] / parts;
        at = shear(x[0], x[1], x[2]);
        while (node < *node_count && sb_v3_norm(sb_v3_sub(list[node], at)) > (sb_real)1e-3)
            node++;
        if (node == *node_count) {
            list[(*node_count)++] = at;
            snprintf(line, sizeof line, "%.17g %.17g %.17g\n", (double)at.x, (double)at.y, (double)at.z);
            put_text(points, line);
        }
        put_integer(cells, 0, node, 4);
    }
    put_text(cells, "\n");
    return count + 1;
}

static void test_curved_cells(void)
{
    static const double hex[8][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0},
                                     {0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}};
    static const double wedge[6][3] = {{1, 0, 0}, {2, 0, 0}, {1, 1, 0}, {1, 0, 1}, {2, 0, 1}, {1, 1, 1}};
    static const double pyramid[5][3] = {{0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}, {0.5, 0.5, 2}};
    static const signed char hex_edges[12][2] = {{0, 1}, {1, 2}, {2, 3}, {3, 0}, {4, 5}, {5, 6},
                                                 {6, 7}, {7, 4}, {0, 4}, {1, 5}, {2, 6}, {3, 7}};
    static const signed char hex_faces[6][4] = {{0, 3, 7, 4}, {1, 2, 6, 5}, {0, 1, 5, 4},
                                                {3, 2, 6, 7}, {0, 1, 2, 3}, {4, 5, 6, 7}};
    static const signed char wedge_edges[9][2] = {{0, 1}, {1, 2}, {2, 0}, {3, 4}, {4, 5},
                                                  {5, 3}, {0, 3}, {1, 4}, {2, 5}};
    static const signed char wedge_faces[3][4] = {{0, 1, 4, 3}, {1, 2, 5, 4}, {2, 0, 3, 5}};
    static const signed char pyramid_edges[8][2] = {{0, 1}, {1, 2}, {2, 3}, {3, 0}, {0, 4}, {1, 4}, {2, 4}, {3, 4}};
    for (int full = 0; full < 2; full++) { /* 1: with nodes in the middle of faces (a pyramid14 is gmsh's only) */
        bytes points = {NULL, 0, 0, 0}, cells = {NULL, 0, 0, 0}, f = {NULL, 0, 0, 0};
        sb_vec3 list[64];
        int node_count = 0, numbers = 0;
        char line[200];
        sb_mesh mesh;
        sb_mesh_report found;
        sb_load_report report;
        sb_error error;
        numbers +=
            put_curved_cell(&points, &cells, &node_count, list, hex, 8, hex_edges, 12, hex_faces, 6 * full, full);
        numbers +=
            put_curved_cell(&points, &cells, &node_count, list, wedge, 6, wedge_edges, 9, wedge_faces, 3 * full, 0);
        numbers += put_curved_cell(&points, &cells, &node_count, list, pyramid, 5, pyramid_edges, 8, NULL, 0, 0);
        snprintf(line, sizeof line,
                 "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS %d double\n", node_count);
        put_text(&f, line);
        put(&f, points.data, points.size);
        snprintf(line, sizeof line, "CELLS 3 %d\n", numbers);
        put_text(&f, line);
        put(&f, cells.data, cells.size);
        put_text(&f, full ? "CELL_TYPES 3\n29 32 27\n" : "CELL_TYPES 3\n25 26 27\n");
        if (CHECK_OK(load(&f, &mesh, NULL, &report, &error))) {
            CHECK_INT(mesh.element_type, SB_TET10);
            CHECK_INT(mesh.element_count, 6 + 3 + 2);
            /* 6 + 3 faces with a diagonal, one shared, and the hexahedron's own, unless the file has them */
            CHECK_INT(mesh.node_count - node_count, full ? 0 : 6 + 3 - 1 + 1);
            CHECK_INT(report.unreferenced_nodes, 0);
            CHECK_NEAR(sb_mesh_volume(&mesh), 1 + 0.5 + 1.0 / 3, 100 * SB_EPSILON);
            if (CHECK_OK(sb_mesh_check(&mesh, NULL, &found, NULL))) {
                CHECK_INT(found.boundary_faces, 2 * 4 + (2 * 2 + 2) + 4);
                CHECK_INT(found.nonmanifold_faces, 0);
                sb_mesh_report_free(&found);
            }
        } else {
            printf("  full %d, element %d: %s\n", full, error.element, error.message);
        }
        sb_mesh_free(&mesh);
        bytes_free(&points);
        bytes_free(&cells);
        bytes_free(&f);
    }
}

/* ---- regions and other fields of VTK files --------------------------------------------------------- */

#define VTK_PAIR                                                                                                       \
    "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 float\n0 0 0 1 0 0 0 1 0 0 0 1 1 1 1\n" \
    "CELLS 2 10\n4 0 1 2 3\n4 1 2 3 4\nCELL_TYPES 2\n10 10\nCELL_DATA 2\n"
#define SCALARS(name, type, values) "SCALARS " name " " type "\nLOOKUP_TABLE default\n" values "\n"

static void test_region_fields(void)
{
    static const struct {
        const char *data, *field, *ignored;
        int count;
    } cases[] = {{SCALARS("material", "int", "3 7"), "material", "", 0},
                 {SCALARS("Material", "float", "3.0 7.0"), "Material", "", 0},
                 {SCALARS("CellEntityIds", "int", "3 7"), "CellEntityIds", "", 0},
                 {SCALARS("material", "int", "1 2") SCALARS("region", "int", "3 7"), "region", "material", 1},
                 {SCALARS("region", "int", "3 7") SCALARS("material", "int", "1 2"), "region", "material", 1},
                 {SCALARS("gmsh:physical", "int", "1 2") SCALARS("MaterialIds", "int", "3 7")
                      SCALARS("q", "double", "0.5 1"),
                  "MaterialIds", "gmsh:physical, q", 2},
                 {SCALARS("region", "int", "3 7") "POINT_DATA 5\n" SCALARS("region", "int", "1 2 3 4 5"), "region",
                  "region", 1}};
    sb_mesh mesh;
    sb_load_report report;
    sb_error error;
    char text[800], words[80];
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        snprintf(text, sizeof text, "%s%s", VTK_PAIR, cases[i].data);
        if (!CHECK_OK(load_text(text, &mesh, NULL, &report, &error)))
            continue;
        expect_pair(&mesh);
        snprintf(words, sizeof words, "cell field %s", cases[i].field);
        CHECK(has_note(&report, words) == (strcmp(cases[i].field, "region") != 0));
        CHECK_INT(report.ignored, cases[i].count);
        CHECK(cases[i].count == 0 || has_note(&report, cases[i].ignored));
        sb_mesh_free(&mesh);
    }
    /* a field of the name that holds no integers, or several in each cell, is none; it is noted */
    if (CHECK_OK(load_text(VTK_PAIR SCALARS("material", "double", "3.5 7") "VECTORS MaterialId int\n1 2 3 4 5 6\n",
                           &mesh, NULL, &report, &error))) {
        CHECK(mesh.regions == NULL && has_note(&report, "material") && has_note(&report, "MaterialId"));
        CHECK_INT(report.ignored, 2);
    }
    sb_mesh_free(&mesh);
    /* very many fields: the note says so and stays bounded */
    {
        bytes f = {NULL, 0, 0, 0};
        put_text(&f, VTK_PAIR "FIELD f 200\n");
        for (int i = 0; i < 200; i++) {
            snprintf(text, sizeof text, "a_rather_long_name_of_field_%d 1 2 int\n1 2\n", i);
            put_text(&f, text);
        }
        if (CHECK_OK(load(&f, &mesh, NULL, &report, &error)))
            CHECK(report.ignored == 200 && has_note(&report, "(200)") && has_note(&report, ", ..."));
        sb_mesh_free(&mesh);
        bytes_free(&f);
    }
}

/* gmsh's order of a tet10 in VTK's file: named, and put right on request. */
static void test_gmsh_order(void)
{
    static const char text[] =
        "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 10 double\n0 0 0\n2 0 0\n0 2 0\n0 0 "
        "2\n"
        "1 0 0\n1 1 0\n0 1 0\n0 0 1\n0 1 1\n1 0 1\nCELLS 1 11\n10 0 1 2 3 4 5 6 7 8 9\nCELL_TYPES 1\n24\n";
    sb_load_options options = sb_default_load_options();
    sb_load_report report;
    sb_mesh mesh;
    sb_error error;
    char path[512];
    memset(&mesh, 0, sizeof mesh);
    options.report = &report;
    CHECK_RESULT(sb_mesh_load_memory(&mesh, text, sizeof text - 1, SB_FILE_AUTO, NULL, &options, &error),
                 SB_ERROR_MESH);
    CHECK(strstr(error.message, "gmsh's node order") != NULL && error.element == 0);
    options.fix_orientation = 1;
    if (CHECK_OK(sb_mesh_load_memory(&mesh, text, sizeof text - 1, SB_FILE_AUTO, NULL, &options, &error))) {
        CHECK_NEAR(sb_mesh_volume(&mesh), 8.0 / 6, 10 * SB_EPSILON);
        CHECK(has_note(&report, "gmsh's node order") && mesh.elements[8] == 9 && mesh.elements[9] == 8);
    }
    sb_mesh_free(&mesh);
    if (!check_shared_path(path, sizeof path, "data/bad/tet10_gmsh_order.vtk")) {
        CHECK_SKIP("the shared data is not there");
        return;
    }
    CHECK_RESULT(sb_mesh_load(&mesh, path, NULL, &error), SB_ERROR_MESH);
    CHECK(strstr(error.message, "all 72 tet10") != NULL && strstr(error.message, "gmsh's node order") != NULL);
    if (CHECK_OK(sb_mesh_load(&mesh, path, &options, &error)))
        CHECK_NEAR(sb_mesh_volume(&mesh), 1.2e-5, 1e-10);
    sb_mesh_free(&mesh);
}

/* ---- errors --------------------------------------------------------------------------------------- */

#define VTU_HEAD "<VTKFile type='UnstructuredGrid' byte_order='LittleEndian'>\n<UnstructuredGrid>\n"
#define VTU_POINTS                                                                                                     \
    "<Points><DataArray type='Float32' NumberOfComponents='3'>\n0 0 0 1 0 0 0 1 0 0 0 1</DataArray></Points>\n"
#define VTU_LIST(c, o, t)                                                                                              \
    "<Cells><DataArray type='Int32' Name='connectivity'>" c "</DataArray>\n<DataArray type='Int32' Name='offsets'>" o  \
    "</DataArray>\n<DataArray type='UInt8' Name='types'>" t "</DataArray></Cells>\n"
#define VTU_TAIL "</Piece></UnstructuredGrid></VTKFile>\n"
#define VTU_PIECE VTU_HEAD "<Piece NumberOfPoints='4' NumberOfCells='1'>\n"
#define MEDIT_HEAD "MeshVersionFormatted 2\nDimension 3\nVertices\n4\n0 0 0 0\n1 0 0 0\n0 1 0 0\n0 0 1 0\n"

static const struct bad_text {
    const char *text;
    sb_result result;
    int line, element;
    const char *word;
} bad_texts[] = {
    {"<FEBio version='4.0'>\n", SB_ERROR_UNSUPPORTED, 1, -1, "FEBio"},
    {"<VTKFile type='ImageData'>\n", SB_ERROR_UNSUPPORTED, 1, -1, "ImageData"},
    {"<VTKFile type='PUnstructuredGrid'>\n", SB_ERROR_UNSUPPORTED, 1, -1, "PUnstructuredGrid"},
    {"<!DOCTYPE x [<!ENTITY a \"b\">]>\n<VTKFile type='UnstructuredGrid'>\n", SB_ERROR_UNSUPPORTED, 1, -1,
     "definitions"},
    {"<VTKFile type='UnstructuredGrid' byte_order='Middle'>\n", SB_ERROR_FORMAT, 1, -1, "Middle"},
    {"<VTKFile type='UnstructuredGrid' header_type='UInt16'>\n", SB_ERROR_FORMAT, 1, -1, "UInt16"},
    {"<VTKFile type=UnstructuredGrid>\n", SB_ERROR_FORMAT, 1, -1, "quoted"},
    {"<VTKFile type>\n", SB_ERROR_FORMAT, 1, -1, "value"},
    {"<VTKFile type='Unstructured\n", SB_ERROR_FORMAT, 0, -1, "attribute"},
    {"<VTKFile\n", SB_ERROR_FORMAT, 0, -1, "tag"},
    {VTU_HEAD, SB_ERROR_FORMAT, 0, -1, "UnstructuredGrid"},
    {VTU_HEAD "</Unstructured>\n", SB_ERROR_FORMAT, 3, -1, "where </UnstructuredGrid>"},
    {VTU_HEAD "</UnstructuredGrid></VTKFile></VTKFile>\n", SB_ERROR_FORMAT, 3, -1, "closes nothing"},
    {VTU_HEAD "<!-- \n", SB_ERROR_FORMAT, 0, -1, "-->"},
    {VTU_HEAD "<Piece NumberOfPoints='-4'>\n", SB_ERROR_FORMAT, 3, -1, "-4"},
    {VTU_HEAD "<Piece NumberOfPoints='4000000000'>\n", SB_ERROR_FORMAT, 3, -1, "4000000000"},
    {VTU_HEAD "<Piece NumberOfPoints='2000000000' NumberOfCells='1'>" VTU_POINTS VTU_LIST("0 1 2 3", "4", "10")
         VTU_TAIL,
     SB_ERROR_FORMAT, 0, -1, "too short"},
    {VTU_HEAD "<Piece NumberOfPoints='4' NumberOfCells='2000000000'>" VTU_POINTS VTU_LIST("0 1 2 3", "4", "10")
         VTU_TAIL,
     SB_ERROR_FORMAT, 0, 1, "ends"},
    {VTU_PIECE VTU_LIST("0 1 2 3", "4", "10") VTU_TAIL, SB_ERROR_FORMAT, 7, -1, "no array of points"},
    {VTU_PIECE VTU_POINTS VTU_TAIL, SB_ERROR_FORMAT, 5, -1, "no array offsets"},
    {VTU_PIECE VTU_POINTS VTU_LIST("0 1 2 4", "4", "10") VTU_TAIL, SB_ERROR_INDEX, 6, 0, "node 4"},
    {VTU_PIECE VTU_POINTS VTU_LIST("0 1 2 -1", "4", "10") VTU_TAIL, SB_ERROR_INDEX, 6, 0, "node -1"},
    {VTU_PIECE VTU_POINTS VTU_LIST("0 1 2", "4", "10") VTU_TAIL, SB_ERROR_FORMAT, 6, 0, "ends"},
    {VTU_PIECE VTU_POINTS VTU_LIST("0 1 2 3 0", "4", "10") VTU_TAIL, SB_ERROR_FORMAT, 6, -1, "more values"},
    {VTU_PIECE VTU_POINTS VTU_LIST("0 1 2 3", "-1", "10") VTU_TAIL, SB_ERROR_FORMAT, 7, 0, "offset"},
    {VTU_PIECE VTU_POINTS VTU_LIST("0 1 2 3", "4", "200") VTU_TAIL, SB_ERROR_UNSUPPORTED, 8, 0, "200"},
    {VTU_PIECE VTU_POINTS VTU_LIST("0 1 2 3", "4", "42") VTU_TAIL, SB_ERROR_UNSUPPORTED, 0, 0, "polyhedron"},
    {VTU_PIECE VTU_POINTS VTU_LIST("0 1 2 3", "4", "13") VTU_TAIL, SB_ERROR_FORMAT, 6, 0, "wedge6"},
    {VTU_PIECE VTU_POINTS VTU_LIST("0 1 2 x", "4", "10") VTU_TAIL, SB_ERROR_FORMAT, 6, 0, "'x'"},
    {VTU_PIECE "<Points><DataArray type='Float32' NumberOfComponents='2'>0 0</DataArray></Points>" VTU_TAIL,
     SB_ERROR_FORMAT, 0, -1, "2 components"},
    {VTU_PIECE "<Points><DataArray type='String' NumberOfComponents='3'>0 0</DataArray></Points>" VTU_TAIL,
     SB_ERROR_FORMAT, 4, -1, "type"},
    {VTU_PIECE
     "<Points><DataArray type='Float32' NumberOfComponents='3'>0 0 0 1 0 0 0 1 0 0 0 nan</DataArray></Points>" VTU_TAIL,
     SB_ERROR_NOT_FINITE, 4, -1, "nan"},
    {VTU_PIECE
     "<Points><DataArray type='Float32' NumberOfComponents='3' format='appended' offset='0'/></Points>" VTU_TAIL,
     SB_ERROR_FORMAT, 4, -1, "appended"},
    {VTU_PIECE
     "<Points><DataArray type='Float32' NumberOfComponents='3' format='binary'>MAAAAA</DataArray></Points>" VTU_TAIL,
     SB_ERROR_FORMAT, 4, -1, "cut off"},
    {VTU_PIECE "<Points><DataArray type='Float32' NumberOfComponents='3' format='hex'>00</DataArray></Points>" VTU_TAIL,
     SB_ERROR_FORMAT, 4, -1, "hex"},
    {"<VTKFile type='UnstructuredGrid' compressor='vtkLZ4DataCompressor'><UnstructuredGrid><Piece NumberOfPoints='1'>\n"
     "<Points><DataArray type='Float32' NumberOfComponents='3' format='binary'>AAAAAA==</DataArray></Points>" VTU_TAIL,
     SB_ERROR_UNSUPPORTED, 2, -1, "LZ4"},
    {VTU_PIECE "<Piece NumberOfPoints='1'>\n", SB_ERROR_FORMAT, 4, -1, "Piece"},
    {VTU_PIECE "</UnstructuredGrid>", SB_ERROR_FORMAT, 4, -1, "where </Piece>"},
    {"MeshVersionFormatted 2\nDimension 4\n", SB_ERROR_UNSUPPORTED, 2, -1, "4"},
    {"MeshVersionFormatted 2\nVertices 1\n0 0 0 0\n", SB_ERROR_FORMAT, 2, -1, "Dimension"},
    {"MeshVersionFormatted 2\nDimension 3\nVertices 2000000000\n0 0 0 0\n", SB_ERROR_FORMAT, 3, -1, "too short"},
    {"MeshVersionFormatted 2\nDimension 3\nVertices 2\n0 0 0 0\n0 x 0 0\n", SB_ERROR_FORMAT, 5, -1, "'x'"},
    {"MeshVersionFormatted 2\nDimension 3\n", SB_ERROR_FORMAT, 0, -1, "Vertices"},
    {MEDIT_HEAD "Vertices 1\n0 0 0 0\n", SB_ERROR_FORMAT, 9, -1, "second"},
    {MEDIT_HEAD "Tetrahedra 1\n1 2 3 5 0\n", SB_ERROR_INDEX, 10, 0, "node 5"},
    {MEDIT_HEAD "Tetrahedra 1\n0 1 2 3 0\n", SB_ERROR_INDEX, 10, 0, "node 0"},
    {MEDIT_HEAD "Tetrahedra 1\n1 2 3 4 99999999999\n", SB_ERROR_FORMAT, 10, 0, "99999999999"},
    {MEDIT_HEAD "Tetrahedra 2\n1 2 3 4 0\nEnd\n", SB_ERROR_FORMAT, 9, -1, "too short"},
    {MEDIT_HEAD "Tetrahedra 2\n1 2 3 4 0\nEnd # and more\n", SB_ERROR_FORMAT, 11, 1, "End"},
    {MEDIT_HEAD "HexahedraQ2 0\nEnd\n", SB_ERROR_UNSUPPORTED, 9, -1, "HexahedraQ2"},
    {MEDIT_HEAD "?\n", SB_ERROR_FORMAT, 9, -1, "'?'"},
    {MEDIT_HEAD "End\n", SB_ERROR_MESH, 0, -1, "no faces"},
    {"$NOD\n1\n1 0 0 0\n$ENDNOD\n$ELM\n1\n1 4 1 1 3 1 1 1\n$ENDELM\n", SB_ERROR_FORMAT, 7, 0, "3 nodes"},
    {"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$NOD\n1\n", SB_ERROR_FORMAT, 4, -1, "version 1"},
    {"$MeshFormat\n3 0 8\n$EndMeshFormat\n$Nodes\n1\n1 0 0 0 1 7\n", SB_ERROR_FORMAT, 6, -1, "dimension 7"},
    {"$MeshFormat\n3 0 8\n$EndMeshFormat\n$Nodes\n1\n1 0 0 0 0\n$EndNodes\n$Elements\n1\n1 4 1 2 1 1\n",
     SB_ERROR_FORMAT, 10, 0, "2 nodes"},
    {"$MeshFormat\n4 0 8\n$EndMeshFormat\n$Nodes\n1 1\n1 7 0 1\n", SB_ERROR_FORMAT, 6, -1, "dimension 7"},
    {"$MeshFormat\n4 0 8\n$EndMeshFormat\n$Nodes\n2000000000 1\n", SB_ERROR_FORMAT, 5, -1, "too short"}};

static void test_errors(void)
{
    for (size_t i = 0; i < sizeof bad_texts / sizeof bad_texts[0]; i++) {
        const struct bad_text *bad = &bad_texts[i];
        int failures = check.failures;
        sb_mesh mesh;
        sb_mesh_sets sets;
        sb_error error;
        memset(&sets, 0x5a, sizeof sets);
        CHECK_RESULT(load_text(bad->text, &mesh, &sets, NULL, &error), bad->result);
        CHECK_INT(error.result, bad->result);
        if (bad->line)
            CHECK_INT(error.line, bad->line);
        CHECK_INT(error.element, bad->element);
        CHECK(strstr(error.message, bad->word) != NULL && strcmp(error.file, "built") == 0);
        CHECK(sets.count == 0x5a5a5a5a && mesh.nodes == NULL);
        if (check.failures != failures)
            printf("  text %d, line %d: %s\n", (int)i, error.line, error.message);
    }
}

/* Elements in each other without end, attributes without end, and a packed block that would unfold into gigabytes. */
static void test_hostile_xml(void)
{
    bytes f = {NULL, 0, 0, 0};
    sb_mesh mesh;
    sb_error error;
    put_text(&f, VTU_HEAD);
    for (int i = 0; i < 5000; i++)
        put_text(&f, "<a>");
    CHECK_RESULT(load(&f, &mesh, NULL, NULL, &error), SB_ERROR_UNSUPPORTED);
    CHECK(strstr(error.message, "deep") != NULL);
    bytes_free(&f);
    put_text(&f, "<VTKFile");
    for (int i = 0; i < 5000; i++)
        put_text(&f, " a=''");
    CHECK_RESULT(load(&f, &mesh, NULL, NULL, &error), SB_ERROR_UNSUPPORTED);
    bytes_free(&f);
    for (int i = 0; i < VTU_CASES; i++) { /* every file cut short at some places */
        bytes whole;
        build_vtu(&whole, i);
        for (size_t size = (size_t)i % 7; size + 200 < whole.size; size += 97) {
            f = whole;
            f.size = size;
            if (load(&f, &mesh, NULL, NULL, &error) == SB_OK)
                sb_mesh_free(&mesh); /* raw data at the end may be short of nothing that was needed */
            else
                CHECK(error.message[0] != 0);
        }
        bytes_free(&whole);
    }
}

/* ---- failing memory and mutations ------------------------------------------------------------------ */

typedef struct ration {
    int left, live; /* allocations until one fails, < 0: never; blocks in use */
    size_t largest;
} ration;

static void *ration_alloc(void *user, size_t size)
{
    ration *r = (ration *)user;
    void *pointer;
    if (r->left == 0)
        return NULL;
    r->left -= r->left > 0;
    r->largest = size > r->largest ? size : r->largest;
    pointer = malloc(size);
    r->live += pointer != NULL;
    return pointer;
}

static void ration_release(void *user, void *pointer)
{
    ((ration *)user)->live -= pointer != NULL;
    free(pointer);
}

static sb_load_options rationed(ration *r, int left)
{
    sb_load_options options = sb_default_load_options();
    memset(r, 0, sizeof *r);
    r->left = left;
    options.allocator.alloc = ration_alloc;
    options.allocator.release = ration_release;
    options.allocator.user = r;
    return options;
}

/* File i of all that are built here. */
enum { GMSH_FILES = 7, MEDIT_FILES = 9, VTU_FILES = 12, FILES = GMSH_FILES + MEDIT_FILES + VTU_FILES + 2 };
static void build_file(bytes *f, int i)
{
    memset(f, 0, sizeof *f);
    if (i < GMSH_FILES) {
        build_gmsh(f, i == 0 ? 1 : i < 4 ? 3 : 4, i > 0 && (i - 1) % 3 > 0, i > 0 && (i - 1) % 3 == 2);
    } else if (i < GMSH_FILES + MEDIT_FILES) {
        build_medit(f, (i - GMSH_FILES + 1) / 2, (i - GMSH_FILES) % 2);
        if (i == GMSH_FILES) {
            memmove(f->data, f->data + 12, f->size - 12);
            f->size -= 12;
        }
    } else if (i < FILES - 2) {
        build_vtu(f, (i - GMSH_FILES - MEDIT_FILES) * 8 + i % 4);
    } else {
        unsigned long long state = 5;
        block b;
        make_block(&b, 1 + i % 2, 0, &state);
        put_block(f, &b, i % 2);
    }
}

/* The first bytes of each file in memory of their own size: sanitizers see a look behind the end. */
static void test_short_files(void)
{
    for (int i = 0; i < FILES; i++) {
        bytes f;
        build_file(&f, i);
        for (size_t size = 0; size < 100 && size < f.size; size++) {
            unsigned char *exact = (unsigned char *)malloc(size ? size : 1);
            memcpy(exact, f.data, size);
            for (int format = SB_FILE_AUTO; format <= SB_FILE_MEDIT; format++) {
                sb_mesh mesh;
                sb_error error;
                memset(&mesh, 0, sizeof mesh);
                if (format == SB_FILE_TETGEN)
                    continue;
                CHECK(sb_mesh_load_memory(&mesh, exact, size, (sb_file_format)format, NULL, NULL, &error) != SB_OK);
                CHECK(error.message[0] && !mesh.nodes);
            }
            free(exact);
        }
        bytes_free(&f);
    }
}

static void test_memory_failures(void)
{
    for (int i = 0; i < FILES; i++) {
        bytes f;
        int left, done = 0;
        build_file(&f, i);
        for (left = 0; left < 300 && !done; left++) {
            ration r;
            sb_load_report report;
            sb_mesh_sets sets;
            sb_load_options options = rationed(&r, left);
            sb_mesh mesh, before;
            sb_error error;
            sb_result result;
            memset(&mesh, 0x5a, sizeof mesh);
            memcpy(&before, &mesh, sizeof mesh);
            memset(&sets, 0x5a, sizeof sets);
            options.report = &report;
            options.sets = &sets;
            result = sb_mesh_load_memory(&mesh, f.data, f.size, SB_FILE_AUTO, NULL, &options, &error);
            done = result == SB_OK;
            if (done) {
                sb_mesh_free(&mesh);
                sb_mesh_sets_free(&sets);
            } else {
                CHECK_RESULT(result, SB_ERROR_MEMORY);
                CHECK(error.result == SB_ERROR_MEMORY && memcmp(&mesh, &before, sizeof mesh) == 0);
                CHECK_INT(sets.count, 0x5a5a5a5a);
            }
            CHECK_INT(r.live, 0);
        }
        CHECK(done && left > 3);
        bytes_free(&f);
    }
}

static void mutate(bytes *f, unsigned long long *state)
{
    static const char *const numbers[] = {"-1",  "0",     "4000000000", "99999999999999999999",
                                          "nan", "1e999", "2147483647", "x"};
    size_t at = (size_t)(check_random(state) * (double)f->size);
    const char *number = numbers[(int)(check_random(state) * 8)];
    size_t length = strlen(number);
    switch ((int)(check_random(state) * 5)) {
    case 0: f->data[at] = (unsigned char)(check_random(state) * 256); break;
    case 1: f->data[at] ^= (unsigned char)(1 << (int)(check_random(state) * 8)); break;
    case 2: f->size = check_random(state) < 0.2 ? at + 1 : f->size; break;
    case 3:
        while (at + 1 < f->size && (f->data[at] < '0' || f->data[at] > '9'))
            at++;
        memcpy(f->data + at, number, length < f->size - at ? length : f->size - at);
        break;
    default:
        length = f->size - at < 20 ? f->size - at : 20;
        memmove(f->data + at, f->data + (size_t)(check_random(state) * (double)(f->size - length)), length);
        break;
    }
}

/* Sound meshes and sets within range, or an error; no leak, and no memory that the file does not account for. */
static void check_mutant(const bytes *f, int fix)
{
    ration r;
    sb_load_options options = rationed(&r, -1);
    sb_mesh mesh;
    sb_mesh_sets sets;
    sb_load_report report;
    sb_error error;
    memset(&mesh, 0, sizeof mesh);
    options.fix_orientation = fix;
    options.sets = &sets;
    options.report = &report;
    if (sb_mesh_load_memory(&mesh, f->data, f->size, SB_FILE_AUTO, "mutant", &options, &error) == SB_OK) {
        int volume = sb_element_dimension(mesh.element_type) == 3;
        CHECK(!volume || sb_mesh_validate(&mesh, NULL) == SB_OK);
        for (int i = 0; i < sets.count; i++) {
            const sb_mesh_set *set = &sets.sets[i];
            int ok = memchr(set->name, 0, sizeof set->name) != NULL;
            for (int k = 0; k < set->node_count; k++)
                ok &= set->nodes[k] >= 0 && set->nodes[k] < mesh.node_count &&
                      (k == 0 || set->nodes[k] > set->nodes[k - 1]);
            for (int k = 0; k < set->element_count; k++)
                ok &= set->elements[k] >= 0 && set->elements[k] < mesh.element_count;
            for (int k = 0; k < set->face_count * set->face_corners; k++)
                ok &= set->faces[k] >= 0 && set->faces[k] < mesh.node_count;
            CHECK(ok);
        }
        sb_mesh_free(&mesh);
        sb_mesh_sets_free(&sets);
    } else {
        CHECK(error.message[0] && strcmp(error.file, "mutant") == 0);
    }
    CHECK_INT(r.live, 0);
    CHECK(r.largest < 1100 * (f->size + 100)); /* the best that deflate can do */
}

static void test_mutations(void)
{
    check_bad_numbers();
    const int rounds = check_quick() ? 200 : 1200;
    unsigned long long state = 20260724;
    for (int i = 0; i < FILES; i++) {
        bytes whole, f = {NULL, 0, 0, 0};
        build_file(&whole, i);
        for (int round = 0; round < rounds; round++) {
            f.size = 0;
            put(&f, whole.data, whole.size);
            for (int k = 0; k <= round % 3; k++)
                mutate(&f, &state);
            check_mutant(&f, round % 2);
        }
        bytes_free(&f);
        bytes_free(&whole);
    }
}

/* ---- real meshes ----------------------------------------------------------------------------------- */

/* A mesh of the shared data, written as VTU by the test, comes back with the same bits. */
static void test_real_meshes(void)
{
    static const char *const names[3] = {"data/volumes/liver_a_tet10_1k.vtk", "data/volumes/bunny_tet4.vtk",
                                         "data/volumes/beam_hex20.vtk"};
    char path[512];
    for (int i = 0; i < 6; i++) {
        static const int types[3] = {24, 10, 25};
        vtu v;
        sb_mesh mesh, back;
        sb_load_report report;
        sb_error error;
        double *values;
        int width, most;
        if (!check_shared_path(path, sizeof path, names[i % 3])) {
            CHECK_SKIP("the shared data is not there");
            return;
        }
        if (!CHECK_OK(sb_mesh_load(&mesh, path, NULL, &error)))
            continue;
        memset(&v, 0, sizeof v);
        v.format = i < 3 ? APPENDED_RAW : INLINE;
        v.packing = i < 3 ? FIXED : PLAIN;
        v.header = 8;
        v.block = 32768;
        width = sb_mesh_element_width(&mesh);
        most = 3 * mesh.node_count > width * mesh.element_count ? 3 * mesh.node_count : width * mesh.element_count;
        values = (double *)malloc((size_t)most * sizeof *values);
        begin_vtu(&v, "UnstructuredGrid");
        {
            char tag[100];
            snprintf(tag, sizeof tag, "<Piece NumberOfPoints=\"%d\" NumberOfCells=\"%d\">\n<Points>\n", mesh.node_count,
                     mesh.element_count);
            put_text(&v.f, tag);
        }
        for (int k = 0; k < mesh.node_count; k++) {
            values[3 * k] = (double)mesh.nodes[k].x;
            values[3 * k + 1] = (double)mesh.nodes[k].y;
            values[3 * k + 2] = (double)mesh.nodes[k].z;
        }
        put_array(&v, "Float64", "Points", 3, values, 3 * mesh.node_count);
        put_text(&v.f, "</Points><Cells>\n");
        for (int k = 0; k < width * mesh.element_count; k++)
            values[k] = mesh.elements[k];
        put_array(&v, "Int64", "connectivity", 1, values, width * mesh.element_count);
        for (int k = 0; k < mesh.element_count; k++)
            values[k] = width * (k + 1);
        put_array(&v, "Int64", "offsets", 1, values, mesh.element_count);
        for (int k = 0; k < mesh.element_count; k++)
            values[k] = types[i % 3];
        put_array(&v, "UInt8", "types", 1, values, mesh.element_count);
        put_text(&v.f, "</Cells></Piece>\n");
        end_vtu(&v, "UnstructuredGrid");
        if (CHECK_OK(load(&v.f, &back, NULL, &report, &error))) {
            CHECK(back.node_count == mesh.node_count &&
                  memcmp(back.nodes, mesh.nodes, (size_t)mesh.node_count * sizeof mesh.nodes[0]) == 0);
            CHECK(back.element_count == mesh.element_count && back.element_type == mesh.element_type &&
                  memcmp(back.elements, mesh.elements, (size_t)(width * mesh.element_count) * sizeof(int)) == 0);
            sb_mesh_free(&back);
        } else {
            printf("  line %d: %s\n", error.line, error.message);
        }
        free(values);
        sb_mesh_free(&mesh);
        bytes_free(&v.f);
    }
}

/* ---- files that are something else ------------------------------------------------------------------ */

/* What people have in place of the file that they think of, by its first bytes, and a word of the error. */
static void test_other_kinds(void)
{
    static const char *const starts[][2] = {{"\x1F\x8B\x08", "gzip"},
                                            {"PK\x03\x04\x14", "zip archive"},
                                            {"7z\xBC\xAF\x27\x1C", "7z"},
                                            {"BZh91AY", "bzip2"},
                                            {"\xFD"
                                             "7zXZ",
                                             "xz"},
                                            {"version https://git-lfs.github.com/spec/v1\n", "LFS"},
                                            {"<!doctype HTML><html>", "web page"},
                                            {"<html><body>", "web page"},
                                            {"\x89PNG\r\n", "PNG"},
                                            {"%PDF-1.7", "PDF"},
                                            {"\xFF\xFE#", "UTF-16"}};
    static const char *const names[] = {"a.vtk", "a.vtu", "a.msh", "a.mesh", "a.obj", "a.stl", "a.ply", "a.off", "a"};
    for (size_t k = 0; k < sizeof starts / sizeof starts[0]; k++) {
        char content[128];
        size_t length = strlen(starts[k][0]);
        sb_image image;
        sb_error error;
        memset(content, 0, sizeof content);
        memcpy(content, starts[k][0], length);
        for (size_t n = 0; n < sizeof names / sizeof names[0]; n++) {
            sb_mesh mesh;
            CHECK_RESULT(sb_mesh_load_memory(&mesh, content, sizeof content, SB_FILE_AUTO, names[n], NULL, &error),
                         SB_ERROR_UNSUPPORTED);
            if (!CHECK(strstr(error.message, starts[k][1]) != NULL))
                printf("    %s: %s\n", names[n], error.message);
        }
        CHECK_RESULT(sb_image_load_memory(&image, content, sizeof content, NULL, NULL, &error), SB_ERROR_UNSUPPORTED);
        CHECK(strstr(error.message, starts[k][1]) != NULL);
    }
}

/* The header of a binary STL file is anybody's. */
static void test_stl_headers(void)
{
    static const char *const headers[] = {"PK\x03\x04", "\x1F\x8B", "<html>", "%PDF", "version https://git-lfs",
                                          "solid"};
    for (size_t k = 0; k < sizeof headers / sizeof headers[0]; k++) {
        bytes f = {NULL, 0, 0, 0};
        char header[80];
        sb_mesh mesh;
        sb_error error;
        memset(header, ' ', sizeof header);
        memcpy(header, headers[k], strlen(headers[k]));
        put(&f, header, sizeof header);
        put_int(&f, 1, 4);
        for (int i = 0; i < 12; i++)
            put_real(&f, i == 3 || i == 7 || i == 2, 4);
        put_int(&f, 0, 2);
        if (CHECK_OK(sb_mesh_load_memory(&mesh, f.data, f.size, SB_FILE_AUTO, "a.stl", NULL, &error)))
            CHECK_INT(mesh.element_count, 1);
        sb_mesh_free(&mesh);
        bytes_free(&f);
    }
}

CHECK_SUITE(meshio_formats, {"gmsh 1, 3 and 4.0", test_gmsh_versions}, {"names of gmsh's groups", test_gmsh_names},
            {"medit", test_medit}, {"vtu in every encoding", test_vtu_encodings}, {"vtu in pieces", test_vtu_pieces},
            {"vtp", test_vtp}, {"inflate", test_inflate}, {"mixed meshes become tets", test_mixed_meshes},
            {"sets of mixed meshes", test_mixed_sets}, {"curved cells become tet10", test_curved_cells},
            {"fields that are regions", test_region_fields}, {"gmsh's tet10 order is named", test_gmsh_order},
            {"errors say where", test_errors}, {"hostile xml", test_hostile_xml},
            {"real meshes as vtu", test_real_meshes}, {"short files", test_short_files},
            {"files that are something else", test_other_kinds}, {"headers of binary STL files", test_stl_headers},
            {"failing memory", test_memory_failures}, {"mutations", test_mutations});
