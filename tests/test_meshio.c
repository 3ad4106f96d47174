/* Mesh files: every format and variant from bytes built here, the prepared good and bad files, round
 * trips, errors, mutations, failing memory. */
#include "softbody.h"

#include "check.h"
#include "mesh_file.h"

/* Under wine the device is there, but takes everything. */
#if defined(_WIN32)
#define SBT_HAS_DEV_FULL 0
#else
#define SBT_HAS_DEV_FULL 1
#endif

#include <float.h>
#include <limits.h>
#include <locale.h>
#include <time.h>

/* A number as text or in binary, as the file has it. */
static void put_number(bytes *b, int binary, double value, int size, int is_float)
{
    char text[40];
    if (binary && is_float) {
        put_real(b, value, size);
    } else if (binary) {
        put_int(b, (long long)value, size);
    } else {
        snprintf(text, sizeof text, "%g ", value);
        put_text(b, text);
    }
}

/* ---- the other mesh of the built files ----------------------------------------------------------- */

/* The surface of a tetrahedron; volume 1/6. Vertices are numbered as the triangles meet them. */
static const double skin_nodes[4][3] = {{0, 0, 0}, {0, 1, 0}, {1, 0, 0}, {0, 0, 1}};
static const int skin_cells[4][3] = {{0, 1, 2}, {0, 3, 1}, {0, 2, 3}, {1, 3, 2}};

static void expect_skin(const sb_mesh *mesh)
{
    expect_nodes(mesh, skin_nodes, 4);
    CHECK_INT(mesh->element_type, SB_TRI3);
    if (!CHECK_INT(mesh->element_count, 4))
        return;
    CHECK(memcmp(mesh->elements, skin_cells, sizeof skin_cells) == 0);
    CHECK(mesh->regions == NULL);
}

/* ---- builders ------------------------------------------------------------------------------------- */

static void put_vtk_points(bytes *b, int binary, const char *type, int size, int is_float, const double nodes[][3],
                           int count)
{
    char line[64];
    snprintf(line, sizeof line, "POINTS %d %s\n", count, type);
    put_text(b, line);
    for (int i = 0; i < 3 * count; i++)
        put_number(b, binary, nodes[i / 3][i % 3], size, is_float);
    put_text(b, "\n");
}

static void put_vtk_head(bytes *b, const char *version, int binary, const char *dataset)
{
    b->big_endian = 1;
    put_text(b, "# vtk DataFile Version ");
    put_text(b, version);
    put_text(b, binary ? "\na title\nBINARY\nDATASET " : "\na title\nASCII\nDATASET ");
    put_text(b, dataset);
    put_text(b, "\n");
}

/* The cell list in the form before 5.0. */
static void put_vtk_cells(bytes *b, const char *keyword, int binary, const int *cells, int count, int nodes)
{
    char line[64];
    snprintf(line, sizeof line, "%s %d %d\n", keyword, count, count * (nodes + 1));
    put_text(b, line);
    for (int i = 0; i < count; i++) {
        put_number(b, binary, nodes, 4, 0);
        for (int k = 0; k < nodes; k++)
            put_number(b, binary, cells[i * nodes + k], 4, 0);
    }
    put_text(b, "\n");
}

/* The form since 5.0. */
static void put_vtk_offsets(bytes *b, const char *keyword, int binary, const int *cells, int count, int nodes)
{
    char line[64];
    snprintf(line, sizeof line, "%s %d %d\nOFFSETS vtktypeint64\n", keyword, count + 1, count * nodes);
    put_text(b, line);
    for (int i = 0; i <= count; i++)
        put_number(b, binary, i * nodes, 8, 0);
    put_text(b, "\nCONNECTIVITY vtktypeint64\n");
    for (int i = 0; i < count * nodes; i++)
        put_number(b, binary, cells[i], 8, 0);
    put_text(b, "\n");
}

static void put_vtk_ints(bytes *b, int binary, const int *values, int count)
{
    for (int i = 0; i < count; i++)
        put_number(b, binary, values[i], 4, 0);
    put_text(b, "\n");
}

static void put_vtk_reals(bytes *b, int binary, int count)
{
    for (int i = 0; i < count; i++)
        put_number(b, binary, 0.5 * i, 4, 1);
    put_text(b, "\n");
}

/* Arrays of every kind around the regions. */
static void put_vtk_data(bytes *b, int binary, int as_field)
{
    put_text(b, "POINT_DATA 5\nVECTORS displacement float\n");
    put_vtk_reals(b, binary, 15);
    put_text(b, "METADATA\nINFORMATION 1\nNAME L2_NORM LOCATION vtkDataArray\nDATA 2 0 1\n\n");
    put_text(b, "SCALARS depth float 2\nLOOKUP_TABLE mine\n");
    put_vtk_reals(b, binary, 10);
    put_text(b, "LOOKUP_TABLE mine 1\n");
    put(b, binary ? "abcd" : "0 1 1 1", binary ? 4 : 7);
    put_text(b, "\nCELL_DATA 2\nCOLOR_SCALARS tint 2\n");
    put(b, binary ? "abcd" : "0 1 1 1", binary ? 4 : 7);
    put_text(b, "\nTENSORS stress float\n");
    put_vtk_reals(b, binary, 18);
    if (!as_field) {
        put_text(b, "SCALARS region int\nLOOKUP_TABLE default\n");
        put_vtk_ints(b, binary, pair_regions, 2);
        put_text(b, "TEXTURE_COORDINATES uv 2 float\n");
        put_vtk_reals(b, binary, 4);
        return;
    }
    put_text(b, "FIELD FieldData 3\nquality 2 2 float\n");
    put_vtk_reals(b, binary, 4);
    put_text(b, "METADATA\nCOMPONENT_NAMES\nX\nY\n\nregion 1 2 double\n");
    for (int i = 0; i < 2; i++)
        put_number(b, binary, pair_regions[i], 8, 1);
    put_text(b, "\nNULL_ARRAY\n");
}

static void build_vtk(bytes *b, const char *version, int binary, int as_field)
{
    static const int types[2] = {10, 10};
    put_vtk_head(b, version, binary, "UNSTRUCTURED_GRID");
    put_text(b, "FIELD FieldData 1\nTIME 1 1 float\n");
    put_vtk_reals(b, binary, 1);
    put_vtk_points(b, binary, "double", 8, 1, pair_nodes, 5);
    if (version[0] == '5')
        put_vtk_offsets(b, "CELLS", binary, &pair_cells[0][0], 2, 4);
    else
        put_vtk_cells(b, "CELLS", binary, &pair_cells[0][0], 2, 4);
    put_text(b, "CELL_TYPES 2\n");
    put_vtk_ints(b, binary, types, 2);
    put_vtk_data(b, binary, as_field);
}
static void build_vtk_ascii(bytes *b) { build_vtk(b, "3.0", 0, 0); }
static void build_vtk_binary(bytes *b) { build_vtk(b, "4.2", 1, 1); }
static void build_vtk51_ascii(bytes *b) { build_vtk(b, "5.1", 0, 1); }
static void build_vtk51_binary(bytes *b) { build_vtk(b, "5.1", 1, 0); }

/* A vertex and a line, then the triangles. */
static void build_vtk_poly(bytes *b, const char *version, int binary)
{
    static const int vertex[1] = {2}, line[2] = {0, 3};
    void (*cells)(bytes *, const char *, int, const int *, int, int) =
        version[0] == '5' ? put_vtk_offsets : put_vtk_cells;
    put_vtk_head(b, version, binary, "POLYDATA");
    put_vtk_points(b, binary, "float", 4, 1, skin_nodes, 4);
    cells(b, "VERTICES", binary, vertex, 1, 1);
    cells(b, "LINES", binary, line, 1, 2);
    cells(b, "POLYGONS", binary, &skin_cells[0][0], 4, 3);
}
static void build_vtk_poly_ascii(bytes *b) { build_vtk_poly(b, "2.0", 0); }
static void build_vtk_poly_binary(bytes *b) { build_vtk_poly(b, "3.0", 1); }
static void build_vtk51_poly(bytes *b) { build_vtk_poly(b, "5.1", 1); }

static void put_gmsh_head(bytes *b, const char *version, int binary, int big_endian, int size_bytes)
{
    char line[64];
    b->big_endian = big_endian;
    put_text(b, "$Comments\nanything $ at all\n$EndComments\n$MeshFormat\n");
    snprintf(line, sizeof line, "%s %d %d\n", version, binary, size_bytes);
    put_text(b, line);
    if (binary) {
        put_int(b, 1, 4);
        put_text(b, "\n");
    }
    put_text(b, "$EndMeshFormat\n$PhysicalNames\n2\n3 3 \"outer\"\n3 7 \"inner\"\n$EndPhysicalNames\n");
}

/* 2.2 with node numbers 10, 20, ..., a point, a triangle and the tetrahedra with physical groups. */
static void build_gmsh2(bytes *b, int binary, int big_endian)
{
    static const int kinds[3] = {15, 2, 4}, nodes[3] = {1, 3, 4}, counts[3] = {1, 1, 2};
    put_gmsh_head(b, "2.2", binary, big_endian, 8);
    put_text(b, "$Nodes\n5\n");
    for (int i = 0; i < 5; i++) {
        put_number(b, binary, 10 * (i + 1), 4, 0);
        for (int k = 0; k < 3; k++)
            put_number(b, binary, pair_nodes[i][k], 8, 1);
    }
    put_text(b, "\n$EndNodes\n$Elements\n4\n");
    for (int kind = 0; kind < 3; kind++) {
        if (binary) {
            put_int(b, kinds[kind], 4);
            put_int(b, counts[kind], 4);
            put_int(b, 2, 4);
        }
        for (int i = 0; i < counts[kind]; i++) {
            put_number(b, binary, 100 + kind + i, 4, 0);
            if (!binary) {
                put_number(b, 0, kinds[kind], 4, 0);
                put_number(b, 0, 2, 4, 0);
            }
            put_number(b, binary, kind == 2 ? pair_regions[i] : 9, 4, 0);
            put_number(b, binary, 1, 4, 0);
            for (int k = 0; k < nodes[kind]; k++)
                put_number(b, binary, 10 * (pair_cells[i][k] + 1), 4, 0);
        }
    }
    put_text(b, "\n$EndElements\n");
}
static void build_gmsh2_ascii(bytes *b) { build_gmsh2(b, 0, 0); }
static void build_gmsh2_little(bytes *b) { build_gmsh2(b, 1, 0); }
static void build_gmsh2_big(bytes *b) { build_gmsh2(b, 1, 1); }

/* An entity of 4.1 with one physical group (0: none) and one bounding entity. */
static void put_gmsh_entity(bytes *b, int binary, int dimension, int tag, int group, int size_bytes)
{
    put_number(b, binary, tag, 4, 0);
    for (int i = 0; i < (dimension ? 6 : 3); i++)
        put_number(b, binary, i, 8, 1);
    put_number(b, binary, group ? 1 : 0, size_bytes, 0);
    if (group)
        put_number(b, binary, group, 4, 0);
    if (!dimension)
        return;
    put_number(b, binary, 1, size_bytes, 0);
    put_number(b, binary, -1, 4, 0);
}

static void put_gmsh_block(bytes *b, int binary, int dimension, int tag, int third, int count, int size_bytes)
{
    put_number(b, binary, dimension, 4, 0);
    put_number(b, binary, tag, 4, 0);
    put_number(b, binary, third, 4, 0);
    put_number(b, binary, count, size_bytes, 0);
}

/* 4.1: nodes in two blocks (the first with parameters), numbered backwards; a triangle; one volume per
 * element. */
static void build_gmsh4(bytes *b, int binary, int big_endian, int size_bytes)
{
    static const int sizes[4] = {2, 5, 1, 5};
    put_gmsh_head(b, "4.1", binary, big_endian, size_bytes);
    put_text(b, "$Entities\n");
    for (int i = 0; i < 4; i++)
        put_number(b, binary, i == 3 ? 2 : i == 1 ? 0 : 1, size_bytes, 0);
    put_gmsh_entity(b, binary, 0, 1, 0, size_bytes);
    put_gmsh_entity(b, binary, 2, 12, 9, size_bytes);
    put_gmsh_entity(b, binary, 3, 12, 7, size_bytes);
    put_gmsh_entity(b, binary, 3, 5, 3, size_bytes);
    put_text(b, "\n$EndEntities\n$Nodes\n");
    for (int i = 0; i < 4; i++)
        put_number(b, binary, sizes[i], size_bytes, 0);
    for (int block = 0; block < 2; block++) {
        int first = block ? 2 : 0, end = block ? 5 : 2;
        put_gmsh_block(b, binary, 2 + block, 12, !block, end - first, size_bytes);
        for (int i = first; i < end; i++)
            put_number(b, binary, 5 - i, size_bytes, 0);
        for (int i = first; i < end; i++)
            for (int k = 0; k < (block ? 3 : 5); k++)
                put_number(b, binary, k < 3 ? pair_nodes[i][k] : 0.25, 8, 1);
    }
    put_text(b, "\n$EndNodes\n$Elements\n");
    for (int i = 0; i < 4; i++)
        put_number(b, binary, i == 0 || i == 1 || i == 3 ? 3 : 1, size_bytes, 0);
    for (int block = 0; block < 3; block++) {
        put_gmsh_block(b, binary, block ? 3 : 2, block == 1 ? 5 : 12, block ? 4 : 2, 1, size_bytes);
        put_number(b, binary, block + 1, size_bytes, 0);
        for (int k = 0; k < (block ? 4 : 3); k++)
            put_number(b, binary, 5 - pair_cells[block ? block - 1 : 0][k], size_bytes, 0);
    }
    put_text(b, "\n$EndElements\n");
}
static void build_gmsh4_ascii(bytes *b) { build_gmsh4(b, 0, 0, 8); }
static void build_gmsh4_little(bytes *b) { build_gmsh4(b, 1, 0, 8); }
static void build_gmsh4_big(bytes *b) { build_gmsh4(b, 1, 1, 4); }

static void build_gmsh_skin(bytes *b)
{
    put_text(b, "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n1 0 0 0\n2 0 1 0\n3 1 0 0\n4 0 0 1\n$EndNodes\n"
                "$Elements\n5\n1 1 2 0 1 1 2\n2 2 2 0 1 1 2 3\n3 2 2 0 1 1 4 2\n4 2 2 0 1 1 3 4\n5 2 2 0 1 2 4 3\n"
                "$EndElements\n");
}

static void build_obj(bytes *b)
{
    put_text(b, "# comment\r\nmtllib C:\\folder\\\r\no thing\r\nvn 0 0 1\r\nvt 0 0\r\nv 0 0 0\r\nv 0 1 0 1.0\r\n"
                "\r\nf 1/1/1 2/1 3//1\r\nv 1 0 0 0.5 0.5 0.5\r\nv 0 0 \\\r\n 1\r\ns off\r\nusemtl a\r\n"
                "f -4 -1 -3 # relative\r\nf 1 \\\r\n3 4\r\nf 2 4 3\r\nl 1 2");
}

static void build_stl_ascii(bytes *b)
{
    char line[160];
    put_text(b, "solid facet of a name\n");
    for (int i = 0; i < 4; i++) {
        put_text(b, i == 2 ? "endsolid\nSOLID another\n" : "");
        put_text(b, "facet normal nan 0 1\n outer loop\n");
        for (int k = 0; k < 3; k++) {
            const double *x = skin_nodes[skin_cells[i][k]];
            snprintf(line, sizeof line, "  vertex %g %s%ge-0 %.8f\n", x[0], i == 1 ? "-" : "", i == 1 ? 0 : x[1], x[2]);
            if (i == 1 && x[1] != 0)
                snprintf(line, sizeof line, "  vertex %g %g %g\n", x[0], x[1], x[2]);
            put_text(b, line);
        }
        put_text(b, " endloop\nendfacet\n");
    }
    put_text(b, "endsolid facet of a name\n");
}

static void build_stl_binary(bytes *b)
{
    char header[81];
    snprintf(header, sizeof header, "%-80s", "solid in name only");
    put(b, header, 80);
    put_int(b, 4, 4);
    for (int i = 0; i < 4; i++) {
        for (int k = 0; k < 3; k++)
            put_real(b, 0, 4);
        for (int k = 0; k < 9; k++)
            put_real(b, skin_nodes[skin_cells[i][k / 3]][k % 3], 4);
        put_int(b, 0, 2);
    }
}

/* Coordinates in three types, extra elements and properties before, between and behind. */
static void build_ply(bytes *b, const char *format, int binary, int big_endian)
{
    b->big_endian = big_endian;
    put_text(b, "ply\nformat ");
    put_text(b, format);
    put_text(b, " 1.0\ncomment made by a test\nelement camera 1\nproperty list uchar short view\nelement vertex 4\n"
                "property uchar red\nproperty float x\nproperty double y\nproperty ushort z\nproperty int flag\n"
                "obj_info more\nelement nothing 3\nelement face 4\nproperty float quality\n"
                "property list uchar int32 vertex_indices\nproperty list int float texcoord\n"
                "element tail 1\nproperty double t\nend_header\n");
    put_number(b, binary, 2, 1, 0);
    put_number(b, binary, -7, 2, 0);
    put_number(b, binary, 8, 2, 0);
    for (int i = 0; i < 4; i++) {
        put_number(b, binary, 200, 1, 0);
        put_number(b, binary, skin_nodes[i][0], 4, 1);
        put_number(b, binary, skin_nodes[i][1], 8, 1);
        put_number(b, binary, skin_nodes[i][2], 2, 0);
        put_number(b, binary, -1, 4, 0);
    }
    for (int i = 0; i < 4; i++) {
        put_number(b, binary, 0.5, 4, 1);
        put_number(b, binary, 3, 1, 0);
        for (int k = 0; k < 3; k++)
            put_number(b, binary, skin_cells[i][k], 4, 0);
        put_number(b, binary, 1, 4, 0);
        put_number(b, binary, 0.25, 4, 1);
    }
    put_number(b, binary, 1, 8, 1);
}
static void build_ply_ascii(bytes *b) { build_ply(b, "ascii", 0, 0); }
static void build_ply_little(bytes *b) { build_ply(b, "binary_little_endian", 1, 0); }
static void build_ply_big(bytes *b) { build_ply(b, "binary_big_endian", 1, 1); }

static void build_off(bytes *b)
{
    put_text(b, "OFF # comment\n\n4 5 6\n0 0 0\n0 1 0 # here too\n1 0 0\n0 0 1\n"
                "3 0 1 2\n3 0 3 1 255 0 0\n2 0 1\n3 0 2 3 0.5\n3 1 3 2\n");
}
static void build_cnoff(bytes *b)
{
    put_text(b, "CNOFF 4 4 6\n0 0 0 0 0 1 0.5 0.5 0.5 1\n0 1 0 0 0 1 1 1 1 1\n1 0 0 0 0 1 1 1 1 1\n"
                "0 0 1 0 0 1 1 1 1 1\n3 0 1 2\n3 0 3 1\n3 0 2 3\n3 1 3 2");
}

/* Every variant of every format that lies in one piece of memory. */
static const struct seed {
    const char *name;
    void (*build)(bytes *b);
    sb_file_format format;
    int is_pair;
    int skipped; /* cells of lower dimension */
} seeds[] = {{"vtk 3.0 ascii", build_vtk_ascii, SB_FILE_VTK, 1, 0},
             {"vtk 4.2 binary", build_vtk_binary, SB_FILE_VTK, 1, 0},
             {"vtk 5.1 ascii", build_vtk51_ascii, SB_FILE_VTK, 1, 0},
             {"vtk 5.1 binary", build_vtk51_binary, SB_FILE_VTK, 1, 0},
             {"vtk polydata ascii", build_vtk_poly_ascii, SB_FILE_VTK, 0, 2},
             {"vtk polydata binary", build_vtk_poly_binary, SB_FILE_VTK, 0, 2},
             {"vtk 5.1 polydata binary", build_vtk51_poly, SB_FILE_VTK, 0, 2},
             {"gmsh 2.2 ascii", build_gmsh2_ascii, SB_FILE_GMSH, 1, 2},
             {"gmsh 2.2 binary little", build_gmsh2_little, SB_FILE_GMSH, 1, 2},
             {"gmsh 2.2 binary big", build_gmsh2_big, SB_FILE_GMSH, 1, 2},
             {"gmsh 4.1 ascii", build_gmsh4_ascii, SB_FILE_GMSH, 1, 1},
             {"gmsh 4.1 binary little", build_gmsh4_little, SB_FILE_GMSH, 1, 1},
             {"gmsh 4.1 binary big", build_gmsh4_big, SB_FILE_GMSH, 1, 1},
             {"gmsh 2.2 surface", build_gmsh_skin, SB_FILE_GMSH, 0, 1},
             {"obj", build_obj, SB_FILE_OBJ, 0, 0},
             {"stl ascii", build_stl_ascii, SB_FILE_STL, 0, 0},
             {"stl binary", build_stl_binary, SB_FILE_STL, 0, 0},
             {"ply ascii", build_ply_ascii, SB_FILE_PLY, 0, 0},
             {"ply binary little", build_ply_little, SB_FILE_PLY, 0, 0},
             {"ply binary big", build_ply_big, SB_FILE_PLY, 0, 0},
             {"off", build_off, SB_FILE_OFF, 0, 1},
             {"cnoff", build_cnoff, SB_FILE_OFF, 0, 0}};
enum { SEED_COUNT = sizeof seeds / sizeof seeds[0] };

static sb_result load_text(sb_mesh *mesh, const char *text, sb_file_format format, sb_error *error)
{
    memset(mesh, 0, sizeof *mesh);
    return sb_mesh_load_memory(mesh, text, strlen(text), format, "text", NULL, error);
}

/* Each text format with a byte order mark, with a NUL behind it, which is forgiven, and in it, which is not. */
static void test_marks_and_nuls(void)
{
    static const struct {
        const char *text;
        sb_file_format format;
    } texts[] = {
        {"# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n0 0 0\n1 0 0\n0 1 0\n"
         "POLYGONS 1 4\n3 0 1 2\n",
         SB_FILE_VTK},
        {"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n3\n1 0 0 0\n2 1 0 0\n3 0 1 0\n$EndNodes\n$Elements\n1\n"
         "1 2 2 0 1 1 2 3\n$EndElements\n",
         SB_FILE_GMSH},
        {"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n# end\n", SB_FILE_OBJ},
        {"solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
         "endsolid s\n",
         SB_FILE_STL},
        {"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
         "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
         SB_FILE_PLY},
        {"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n", SB_FILE_OFF}};
    sb_mesh mesh;
    sb_error error;
    for (size_t i = 0; i < sizeof texts / sizeof texts[0]; i++) {
        char text[512] = "\xEF\xBB\xBF";
        size_t size = 3 + strlen(texts[i].text);
        int lines = 0;
        strcat(text, texts[i].text);
        for (size_t k = 0; k < size; k++)
            lines += text[k] == '\n';
        for (size_t skip = 0; skip <= 3; skip += 3)
            for (size_t nuls = 0; nuls < 2; nuls++) {
                memset(&mesh, 0, sizeof mesh);
                if (CHECK_OK(sb_mesh_load_memory(&mesh, text + skip, size - skip + nuls, SB_FILE_AUTO, "text", NULL,
                                                 &error)))
                    CHECK(mesh.node_count == 3 && mesh.element_count == 1);
                else
                    printf("    %s: %s\n", texts[i].text, error.message);
                sb_mesh_free(&mesh);
            }
        text[size - 2] = 0; /* in the last line, be it a comment */
        CHECK_RESULT(sb_mesh_load_memory(&mesh, text, size, texts[i].format, "text", NULL, &error), SB_ERROR_FORMAT);
        CHECK(strstr(error.message, "NUL") != NULL);
        CHECK_INT(error.line, lines);
    }
    CHECK_RESULT(sb_mesh_load_memory(&mesh, "\xFF\xFEv\0 \0001\0", 8, SB_FILE_AUTO, "a.obj", NULL, &error),
                 SB_ERROR_UNSUPPORTED);
    CHECK_RESULT(sb_mesh_load_memory(&mesh, "\xFE\xFF\0v\0 \0001", 8, SB_FILE_AUTO, "a.obj", NULL, &error),
                 SB_ERROR_UNSUPPORTED);
}

static void test_variants(void)
{
    for (int i = 0; i < SEED_COUNT; i++) {
        bytes b = {NULL, 0, 0, 0};
        sb_mesh mesh;
        sb_error error;
        sb_load_report report;
        sb_load_options options = sb_default_load_options();
        int failures = check.failures;
        options.report = &report;
        memset(&mesh, 0, sizeof mesh);
        seeds[i].build(&b);
        for (int named = 0; named < 2; named++) {
            if (CHECK_OK(sb_mesh_load_memory(&mesh, b.data, b.size, named ? seeds[i].format : SB_FILE_AUTO, NULL,
                                             &options, &error))) {
                if (seeds[i].is_pair)
                    expect_pair(&mesh);
                else
                    expect_skin(&mesh);
                CHECK_INT(report.format, seeds[i].format);
                CHECK_INT(report.skipped_cells, seeds[i].skipped);
                CHECK_INT(report.file_cells, mesh.element_count + report.skipped_cells);
                CHECK_INT(report.merged_vertices, seeds[i].format == SB_FILE_STL ? 8 : 0);
                CHECK_INT(report.unreferenced_nodes + report.flipped_elements + report.split_polygons, 0);
            } else {
                printf("  line %d: %s\n", error.line, error.message);
            }
            sb_mesh_free(&mesh);
        }
        if (check.failures != failures)
            printf("  in the variant %s\n", seeds[i].name);
        bytes_free(&b);
    }
}

/* ---- details of the formats ----------------------------------------------------------------------- */

static void test_vtk_types(void)
{
    static const struct {
        const char *name;
        int size, is_float;
    } types[] = {{"unsigned_char", 1, 0}, {"char", 1, 0},         {"short", 2, 0},         {"unsigned_short", 2, 0},
                 {"int", 4, 0},           {"unsigned_int", 4, 0}, {"long", 8, 0},          {"unsigned_long", 8, 0},
                 {"vtkIdType", 4, 0},     {"vtktypeint64", 8, 0}, {"vtktypeuint64", 8, 0}, {"float", 4, 1},
                 {"double", 8, 1}};
    for (size_t i = 0; i < 2 * sizeof types / sizeof types[0]; i++) {
        int type = (int)(i / 2), binary = (int)(i % 2);
        bytes b = {NULL, 0, 0, 0};
        sb_mesh mesh;
        memset(&mesh, 0, sizeof mesh);
        put_vtk_head(&b, "3.0", binary, "POLYDATA");
        put_vtk_points(&b, binary, types[type].name, types[type].size, types[type].is_float, skin_nodes, 4);
        put_vtk_cells(&b, "POLYGONS", binary, &skin_cells[0][0], 4, 3);
        if (CHECK_OK(sb_mesh_load_memory(&mesh, b.data, b.size, SB_FILE_AUTO, NULL, NULL, NULL)))
            expect_skin(&mesh);
        sb_mesh_free(&mesh);
        bytes_free(&b);
    }
}

/* Texts that hold a surface or volume: type, counts and volume (signed; 0: not looked at). */
static void expect_text(const char *text, sb_file_format format, sb_element_type type, int nodes, int elements,
                        double volume)
{
    sb_mesh mesh;
    sb_error error;
    memset(&error, 0, sizeof error);
    if (!CHECK_OK(load_text(&mesh, text, format, &error))) {
        printf("  line %d: %s\n  of: %.60s\n", error.line, error.message, text);
        return;
    }
    CHECK_INT(mesh.element_type, type);
    CHECK_INT(mesh.node_count, nodes);
    CHECK_INT(mesh.element_count, elements);
    if (volume != 0)
        CHECK_NEAR(sb_mesh_volume(&mesh), volume, 10 * SB_EPSILON);
    sb_mesh_free(&mesh);
}

#define VTK_HEAD "# vtk DataFile Version 3.0\nt\nASCII\nDATASET "
#define VTK_CUBE "POINTS 8 int\n0 0 0 1 0 0 0 1 0 1 1 0 0 0 1 1 0 1 0 1 1 1 1 1\n"

static void test_vtk_cells(void)
{
    /* a voxel counts rows, a hexahedron goes round */
    expect_text(VTK_HEAD "UNSTRUCTURED_GRID\n" VTK_CUBE "CELLS 1 9\n8 0 1 2 3 4 5 6 7\nCELL_TYPES 1\n11\n", SB_FILE_VTK,
                SB_HEX8, 8, 1, 1);
    expect_text(VTK_HEAD "UNSTRUCTURED_GRID\n" VTK_CUBE "CELLS 1 9\n8 0 1 3 2 4 5 7 6\nCELL_TYPES 1\n12\n", SB_FILE_VTK,
                SB_HEX8, 8, 1, 1);
    /* quadrilaterals alone stay, among triangles they are cut */
    expect_text(VTK_HEAD "UNSTRUCTURED_GRID\n" VTK_CUBE "CELLS 2 10\n4 0 1 3 2\n4 4 5 6 7\nCELL_TYPES 2\n9 8\n",
                SB_FILE_VTK, SB_QUAD4, 8, 2, 0);
    expect_text(VTK_HEAD "UNSTRUCTURED_GRID\n" VTK_CUBE
                         "CELLS 3 14\n4 0 1 3 2\n3 4 5 6\n4 4 5 6 7\nCELL_TYPES 3\n9 5 8\n",
                SB_FILE_VTK, SB_TRI3, 8, 5, 0);
    /* all sides of the cube: strips round it and two polygons */
    expect_text(VTK_HEAD "POLYDATA\n" VTK_CUBE "POLYGONS 2 10\n4 0 2 3 1\n4 4 5 7 6\n"
                         "TRIANGLE_STRIPS 1 11\n10 0 4 2 6 3 7 1 5 0 4\n",
                SB_FILE_VTK, SB_TRI3, 8, 12, 1);
    /* empty sections, words instead of numbers in data that is skipped, text arrays */
    expect_text(VTK_HEAD "POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\nVERTICES 0 0\nPOLYGONS 1 4\n3 0 1 2\n"
                         "POINT_DATA 3\nSCALARS a double\nLOOKUP_TABLE default\nnan inf -nan\n"
                         "FIELD f 2\nnames 1 3 string\none\ntwo%20words\n\nb 1 3 int\n1 2 3\n",
                SB_FILE_VTK, SB_TRI3, 3, 1, 0);
}

/* The regions of the elements that stay: the triangle before them and the parts of a polygon have theirs. */
static void test_vtk_regions(void)
{
    sb_mesh mesh;
    if (CHECK_OK(load_text(&mesh,
                           VTK_HEAD "UNSTRUCTURED_GRID\nPOINTS 5 float\n0 0 0 1 0 0 0 1 0 0 0 1 1 1 1\n"
                                    "CELLS 3 14\n3 0 1 2\n4 0 1 2 3\n4 1 2 3 4\nCELL_TYPES 3\n5 10 10\n"
                                    "CELL_DATA 3\nSCALARS region unsigned_char\nLOOKUP_TABLE default\n9 3 7\n",
                           SB_FILE_VTK, NULL)))
        expect_pair(&mesh);
    sb_mesh_free(&mesh);
    if (CHECK_OK(load_text(&mesh,
                           VTK_HEAD "POLYDATA\n" VTK_CUBE "LINES 1 3\n2 0 1\nPOLYGONS 2 9\n4 0 1 3 2\n3 4 5 6\n"
                                    "CELL_DATA 3\nFIELD f 1\nRegion 1 3 short\n9 -3 7\n",
                           SB_FILE_VTK, NULL)) &&
        CHECK(mesh.element_count == 3 && mesh.regions))
        CHECK(mesh.regions[0] == -3 && mesh.regions[1] == -3 && mesh.regions[2] == 7);
    sb_mesh_free(&mesh);
    CHECK_RESULT(load_text(&mesh,
                           VTK_HEAD "POLYDATA\n" VTK_CUBE "POLYGONS 1 4\n3 4 5 6\nLINES 1 3\n2 0 1\n"
                                    "CELL_DATA 2\nSCALARS region int\nLOOKUP_TABLE default\n1 2\n",
                           SB_FILE_VTK, NULL),
                 SB_ERROR_UNSUPPORTED);
}

static void test_gmsh_tet10(void)
{
    /* gmsh lists the edge 2-3 before 1-3 */
    static const int expected[10] = {0, 1, 2, 3, 4, 5, 6, 7, 9, 8};
    sb_mesh mesh;
    if (CHECK_OK(load_text(&mesh,
                           "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n10\n1 0 0 0\n2 2 0 0\n3 0 2 0\n4 0 0 2\n"
                           "5 1 0 0\n6 1 1 0\n7 0 1 0\n8 0 0 1\n9 0 1 1\n10 1 0 1\n$EndNodes\n$Elements\n1\n"
                           "1 11 2 0 1 1 2 3 4 5 6 7 8 9 10\n$EndElements\n",
                           SB_FILE_AUTO, NULL))) {
        CHECK_INT(mesh.element_type, SB_TET10);
        CHECK(memcmp(mesh.elements, expected, sizeof expected) == 0);
        CHECK(mesh.regions == NULL);
    }
    sb_mesh_free(&mesh);
}

/* The nodes of the cube [0, 2]^3 in gmsh's order of hex27: corners, edges by their lower corner, faces z- y- x- x+ y+
 * z+, the centre (documentation of gmsh, "Node ordering"). Read as hex20 and hex27 they must stand where our element
 * has them. */
static void test_gmsh_hexes(void)
{
    static const int at[27][3] = {{0, 0, 0}, {2, 0, 0}, {2, 2, 0}, {0, 2, 0}, {0, 0, 2}, {2, 0, 2}, {2, 2, 2},
                                  {0, 2, 2}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {2, 1, 0}, {2, 0, 1}, {1, 2, 0},
                                  {2, 2, 1}, {0, 2, 1}, {1, 0, 2}, {0, 1, 2}, {2, 1, 2}, {1, 2, 2}, {1, 1, 0},
                                  {1, 0, 1}, {0, 1, 1}, {2, 1, 1}, {1, 2, 1}, {1, 1, 2}, {1, 1, 1}};
    for (int nodes = 20; nodes <= 27; nodes += 7) {
        char text[2000];
        int used = snprintf(text, sizeof text, "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n%d\n", nodes);
        sb_mesh mesh;
        for (int i = 0; i < nodes; i++)
            used +=
                snprintf(text + used, sizeof text - (size_t)used, "%d %d %d %d\n", i + 1, at[i][0], at[i][1], at[i][2]);
        used += snprintf(text + used, sizeof text - (size_t)used, "$EndNodes\n$Elements\n1\n1 %d 2 0 1",
                         nodes == 20 ? 17 : 12);
        for (int i = 0; i < nodes; i++)
            used += snprintf(text + used, sizeof text - (size_t)used, " %d", i + 1);
        snprintf(text + used, sizeof text - (size_t)used, "\n$EndElements\n");
        if (!CHECK_OK(load_text(&mesh, text, SB_FILE_AUTO, NULL)))
            continue;
        CHECK_INT(mesh.element_type, nodes == 20 ? SB_HEX20 : SB_HEX27);
        for (int a = 0; a < nodes; a++) {
            sb_real xi[3] = {0, 0, 0};
            sb_vec3 x = mesh.nodes[mesh.elements[a]];
            sb_element_node_point(mesh.element_type, a, xi);
            CHECK(x.x == 1 + xi[0] && x.y == 1 + xi[1] && x.z == 1 + xi[2]);
        }
        CHECK_NEAR(sb_mesh_volume(&mesh), 8, 100 * SB_EPSILON);
        sb_mesh_free(&mesh);
    }
}

/* gmsh's quad8 (16) and quad9 (10) have our order; so has VTK's 29 for hex27. */
static void test_quadratic_texts(void)
{
#define QUAD9_NODES "1 0 0 0\n2 2 0 0\n3 2 2 0\n4 0 2 0\n5 1 0 0\n6 2 1 0\n7 1 2 0\n8 0 1 0\n9 1 1 0\n"
    sb_mesh mesh;
    expect_text("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n9\n" QUAD9_NODES "$EndNodes\n$Elements\n1\n"
                "1 10 2 0 1 1 2 3 4 5 6 7 8 9\n$EndElements\n",
                SB_FILE_AUTO, SB_QUAD9, 9, 1, 0);
    expect_text("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n9\n" QUAD9_NODES "$EndNodes\n$Elements\n1\n"
                "1 16 2 0 1 1 2 3 4 5 6 7 8\n$EndElements\n",
                SB_FILE_AUTO, SB_QUAD8, 9, 1, 0);
    if (CHECK_OK(load_text(&mesh,
                           "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n9\n" QUAD9_NODES "$EndNodes\n$Elements\n1\n"
                           "1 10 2 0 1 1 2 3 4 5 6 7 8 9\n$EndElements\n",
                           SB_FILE_AUTO, NULL)))
        CHECK_NEAR(sb_mesh_surface_area(&mesh), 4, 32 * SB_EPSILON);
    sb_mesh_free(&mesh);
    /* a hex27 by VTK's vtkTriQuadraticHexahedron: 0-19 as hex20, then x- x+ y- y+ z- z+, the centre */
    expect_text(VTK_HEAD
                "UNSTRUCTURED_GRID\nPOINTS 27 float\n0 0 0 2 0 0 2 2 0 0 2 0 0 0 2 2 0 2 2 2 2 0 2 2\n"
                "1 0 0 2 1 0 1 2 0 0 1 0 1 0 2 2 1 2 1 2 2 0 1 2 0 0 1 2 0 1 2 2 1 0 2 1\n"
                "0 1 1 2 1 1 1 0 1 1 2 1 1 1 0 1 1 2 1 1 1\nCELLS 1 28\n27 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 "
                "17 18 19 20 21 22 23 24 25 26\nCELL_TYPES 1\n29\n",
                SB_FILE_VTK, SB_HEX27, 27, 1, 0);
#undef QUAD9_NODES
}

static void test_surface_texts(void)
{
    /* a polygon of 5, faces before their vertices, old Macintosh line ends */
    expect_text("f 1 2 3 4 5\nv 0 0 0\nv 2 0 0\nv 2 1 0\nv 1 2 0\nv 0 1 0\n", SB_FILE_OBJ, SB_TRI3, 5, 3, 0);
    expect_text("v 0 0 0\rv 1 0 0\rv 0 1 0\rf 1 2 3\r", SB_FILE_OBJ, SB_TRI3, 3, 1, 0);
    expect_text("\xEF\xBB\xBFv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", SB_FILE_AUTO, SB_TRI3, 3, 1, 0);
    expect_text("OFF\n4 1\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n", SB_FILE_AUTO, SB_TRI3, 4, 2, 0);
    expect_text("ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
                "element face 1\nproperty list uint8 uint vertex_index\nend_header\n"
                "0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n",
                SB_FILE_AUTO, SB_TRI3, 4, 2, 0);
}

/* ---- numbers -------------------------------------------------------------------------------------- */

/* Reads one number as the x of a vertex; NaN when that fails. */
static double read_number(const char *text)
{
    static char file[2000];
    sb_mesh mesh;
    double x = (double)NAN;
    snprintf(file, sizeof file, "v %s 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", text);
    if (load_text(&mesh, file, SB_FILE_OBJ, NULL) == SB_OK)
        x = (double)mesh.nodes[0].x;
    sb_mesh_free(&mesh);
    return x;
}

static void check_number(const char *text)
{
    double expected = (double)(sb_real)strtod(text, NULL), actual = read_number(text);
    if (memcmp(&expected, &actual, sizeof actual) != 0) {
        check.failures++;
        printf("[%s] '%.60s' is read as %.17g, not %.17g\n", check.test, text, actual, expected);
    }
}

static void test_numbers_exact(void)
{
    static const char *const texts[] = {
        "0",
        "-0",
        "+1",
        "1.",
        ".5",
        "-.5e1",
        "00012.500",
        "1e5",
        "1E+5",
        "123456789012345678901234567890",
        "0.1",
        "1e22",
        "1e23",
        "9007199254740993",
        "9007199254740992.99999999999999999",
        "9007199254740993.0000000000000001",
        "18446744073709551615",
        "18446744073709551616",
        "1e-22",
        "3.4028234663852886e38",
        "1.17549435e-38",
#if !SB_REAL_IS_FLOAT
        "1.7976931348623157e308",
        "1.7976931348623158e308",
        "2.2250738585072014e-308",
        "2.2250738585072011e-308",
        "4.9406564584124654e-324",
        "2.4703282292062328e-324",
        "2.4703282292062327e-324",
        "1e-400",
        "179769313486231570000000000000000000000e270",
        "0.000000000000000000000000000001e330",
        "6.631236846766476e-316",
        "8.41e21",
        "2.0416694015208685e-176",
#endif
        "0e999999999999999999999",
        "0.00000000000000000000000000000000000000000000000000000000000000000001"
    };
    static char text[1200];
    unsigned long long state = 88172645463325252ULL;
    for (size_t i = 0; i < sizeof texts / sizeof texts[0]; i++)
        check_number(texts[i]);
    for (int i = 0; i < 6000; i++) {
        int range = SB_REAL_IS_FLOAT ? 36 : 300;
        double mantissa = check_random_in(&state, -10, 10), exponent = floor(check_random_in(&state, -range, range));
        if (i % 2)
            exponent = floor(exponent * 25 / range);
        snprintf(text, sizeof text, i % 3 ? "%.17ge%d" : "%.16fe%d", mantissa, (int)exponent);
        check_number(text);
    }
    /* halfway between two doubles, told apart only by a digit far behind: 2^53 + 1 with 700 zeros, then 0
     * or 1 */
    for (int i = 0; i < 3; i++) {
        memset(text, '0', sizeof text);
        memcpy(text, "9007199254740993.", 17);
        text[1100] = (char)('0' + i);
        text[1101] = 0;
        check_number(text);
    }
}

static void test_numbers_refused(void)
{
    static const char *const texts[] = {
        "",    ".",         "-",      "+-1",      "1.0abc", "0,5",   "1e",
        "1e+", "1.2.3",     "0x10",   "1_000",    "1e5.0",  "nan",   "-NaN",
        "inf", "-Infinity", "1.#INF", "nan(ind)", "2e308",  "1e999", "1.7976931348623159e308",
        "e5",  "--1",       "1-1",    "\x01"};
    sb_mesh mesh;
    sb_error error;
    check_bad_numbers();
    for (size_t i = 1; i < sizeof texts / sizeof texts[0]; i++)
        if (!CHECK(!(read_number(texts[i]) - 1 < 1e308)))
            printf("  '%s' was taken for a number\n", texts[i]);
    CHECK_RESULT(load_text(&mesh, "v 0 0 0\nv 1 nan 0\n", SB_FILE_OBJ, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.line, 2);
    CHECK_INT(error.node, 1);
    CHECK(strcmp(error.file, "text") == 0);
#if SB_REAL_IS_FLOAT
    CHECK(!(read_number("1e39") < 1e308));
#endif
}

/* ---- temporary files ------------------------------------------------------------------------------ */

static const char *temporary(const char *ending)
{
    static char path[300];
    static unsigned long tag;
    const char *folder = getenv("TMPDIR") ? getenv("TMPDIR") : getenv("TEMP");
    if (!tag)
        tag = (unsigned long)time(NULL) ^ (unsigned long)(size_t)&folder ^ (unsigned long)clock() << 12;
    snprintf(path, sizeof path, "%s/sb_meshio_%lx%s", folder ? folder : "/tmp", tag, ending);
    return path;
}

static void write_file(const char *path, const void *data, size_t size)
{
    FILE *file = fopen(path, "wb");
    if (CHECK(file != NULL)) {
        CHECK(fwrite(data, 1, size, file) == size);
        fclose(file);
    }
}

static int file_exists(const char *path)
{
    FILE *file = fopen(path, "rb");
    if (file)
        fclose(file);
    return file != NULL;
}

/* ---- TetGen --------------------------------------------------------------------------------------- */

static sb_result load_tetgen(sb_mesh *mesh, const char *nodes, const char *elements, const char *ending,
                             const sb_load_options *options, sb_error *error)
{
    sb_result result;
    write_file(temporary(".node"), nodes, strlen(nodes));
    if (elements)
        write_file(temporary(".ele"), elements, strlen(elements));
    memset(mesh, 0, sizeof *mesh);
    result = sb_mesh_load(mesh, temporary(ending), options, error);
    remove(temporary(".node"));
    remove(temporary(".ele"));
    return result;
}

#define TETGEN_NODES "# nodes\n5 3 1 1\n1 0 0 0 0.5 1\n2 1 0 0 0.5 0\n3 0 1 0 1 0 # here\n\n4 0 0 1 1 1\n5 1 1 1 1 1\n"
#define TETGEN_CELLS "2 4 1\n1 1 2 3 4 3\n2 2 3 4 5 7.0\n# end\n"

static void test_tetgen(void)
{
    sb_mesh mesh;
    sb_error error;
    for (int i = 0; i < 2; i++) {
        if (CHECK_OK(load_tetgen(&mesh, TETGEN_NODES, TETGEN_CELLS, i ? ".ele" : ".node", NULL, &error)))
            expect_pair(&mesh);
        sb_mesh_free(&mesh);
    }
    if (CHECK_OK(
            load_tetgen(&mesh, "4 3\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n", "1 4\n0 0 1 2 3\n", ".ele", NULL, NULL)))
        CHECK_NEAR(sb_mesh_volume(&mesh), 1.0 / 6, SB_EPSILON);
    sb_mesh_free(&mesh);
    /* mid-edge nodes in whatever order: here 23 03 01 12 13 02 */
    if (CHECK_OK(load_tetgen(&mesh,
                             "10 3 0 0\n1 0 0 0\n2 2 0 0\n3 0 2 0\n4 0 0 2\n5 0 1 1\n6 0 0 1\n7 1 0 0\n8 1 1 0\n"
                             "9 1 0 1\n10 0 1 0\n",
                             "1 10 0\n1 1 2 3 4 5 6 7 8 9 10\n", ".node", NULL, NULL))) {
        static const int expected[10] = {0, 1, 2, 3, 6, 7, 9, 5, 8, 4};
        CHECK(memcmp(mesh.elements, expected, sizeof expected) == 0);
    }
    sb_mesh_free(&mesh);
    CHECK_RESULT(load_tetgen(&mesh, TETGEN_NODES, "2 4 1\n1 1 2 3 4 3\n2 2 3 4 6 7\n", ".node", NULL, &error),
                 SB_ERROR_INDEX);
    CHECK_INT(error.line, 3);
    CHECK_INT(error.element, 1);
    CHECK(strstr(error.file, ".ele") != NULL);
    CHECK_RESULT(load_tetgen(&mesh, TETGEN_NODES, NULL, ".node", NULL, &error), SB_ERROR_FILE);
    CHECK(strstr(error.file, ".ele") != NULL);
    CHECK_RESULT(load_tetgen(&mesh, "5 3\n1 0 0 0\n2 1 0 0\n4 0 1 0\n", TETGEN_CELLS, ".node", NULL, &error),
                 SB_ERROR_FORMAT);
    CHECK_RESULT(load_tetgen(&mesh, "4 3\n1 0 0 0 9\n2 1 0 0\n3 0 1 0\n4 0 0 1\n", TETGEN_CELLS, ".node", NULL, &error),
                 SB_ERROR_FORMAT);
    CHECK_INT(error.line, 2);
    CHECK_RESULT(load_tetgen(&mesh, TETGEN_NODES, "2 4 1\n1 1 2 3 4 3.5\n2 2 3 4 5 7\n", ".node", NULL, &error),
                 SB_ERROR_FORMAT);
    CHECK_RESULT(load_tetgen(&mesh, TETGEN_NODES, "1 4 1\n1 1 2 3 4 3\n2 2 3 4 5 7\n", ".node", NULL, &error),
                 SB_ERROR_FORMAT);
    CHECK_RESULT(load_tetgen(&mesh, TETGEN_NODES, "1 5 0\n1 1 2 3 4 5\n", ".node", NULL, &error), SB_ERROR_UNSUPPORTED);
    CHECK_RESULT(load_tetgen(&mesh, "3 2 0 0\n1 0 0\n2 1 0\n3 0 1\n", TETGEN_CELLS, ".node", NULL, &error),
                 SB_ERROR_UNSUPPORTED);
    CHECK_RESULT(load_tetgen(&mesh, "1 3 0 2\n1 0 0 0 1 1\n", TETGEN_CELLS, ".node", NULL, &error), SB_ERROR_FORMAT);
    /* a mid-edge node that is not in the middle */
    CHECK_RESULT(load_tetgen(&mesh,
                             "10 3\n1 0 0 0\n2 2 0 0\n3 0 2 0\n4 0 0 2\n5 1 0.2 0\n6 1 1 0\n7 0 1 0\n8 0 0 1\n"
                             "9 1 0 1\n10 0 1 1\n",
                             "1 10\n1 1 2 3 4 5 6 7 8 9 10\n", ".ele", NULL, &error),
                 SB_ERROR_MESH);
    CHECK_INT(error.element, 0);
    CHECK_RESULT(load_text(&mesh, TETGEN_NODES, SB_FILE_TETGEN, &error), SB_ERROR_ARGUMENT);
}

/* ---- errors --------------------------------------------------------------------------------------- */

#define GMSH_HEAD "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n"
#define GMSH_NODES "$Nodes\n4\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n$EndNodes\n"
#define GMSH4_HEAD "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n"
#define PLY_HEAD "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
#define PLY_FACE "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n"
#define VTK_TET VTK_HEAD "UNSTRUCTURED_GRID\nPOINTS 4 float\n0 0 0 1 0 0 0 1 0 0 0 1\n"

static const struct bad_text {
    sb_file_format format;
    const char *text;
    sb_result result;
    int line, element;
    const char *word; /* in the message */
} bad_texts[] = {
    {SB_FILE_AUTO, "hello world\n", SB_ERROR_FORMAT, 1, -1, "format"},
    {SB_FILE_AUTO, "<?xml version=\"1.0\"?>\n<VTKFile>\n", SB_ERROR_FORMAT, 2, -1, "type"},
    {SB_FILE_VTK, "# vtk DataFile Version 9.0\n", SB_ERROR_UNSUPPORTED, 1, -1, "9.0"},
    {SB_FILE_VTK, "# vtk DataFile Version 3.0\nt\nEBCDIC\n", SB_ERROR_FORMAT, 3, -1, "EBCDIC"},
    {SB_FILE_VTK, VTK_HEAD "STRUCTURED_POINTS\n", SB_ERROR_UNSUPPORTED, 4, -1, "STRUCTURED_POINTS"},
    {SB_FILE_VTK, VTK_HEAD "POLYDATA\nPOINTS 1 quaternion\n", SB_ERROR_FORMAT, 5, -1, "quaternion"},
    {SB_FILE_VTK, VTK_TET "CELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n99\n", SB_ERROR_UNSUPPORTED, 10, 0, "99"},
    {SB_FILE_VTK, VTK_TET "CELLS 1 5\n4 0 1 2 3\nCELL_TYPES 2\n10 10\n", SB_ERROR_FORMAT, 9, -1, "2 cell types"},
    {SB_FILE_VTK, VTK_TET "CELLS 2 9\n4 0 1 2 3\n3 0 1 2\nCELL_TYPES 2\n10 13\n", SB_ERROR_FORMAT, 11, 1, "wedge6"},
    {SB_FILE_VTK,
     VTK_TET "CELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\nCELL_DATA 1\nSCALARS region float\n"
             "LOOKUP_TABLE default\n0.5\n",
     SB_ERROR_FORMAT, 14, 0, "region"},
    {SB_FILE_VTK, VTK_TET "CELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\nCELL_DATA 2\n", SB_ERROR_FORMAT, 11, -1, "2 cells"},
    {SB_FILE_VTK, VTK_TET "CELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n10\nCELL_DATA 1\nVECTORS u float\n1 2\n",
     SB_ERROR_FORMAT, 0, -1, "ends"},
    {SB_FILE_VTK, VTK_TET "CELLS 2 4\nOFFSETS vtktypeint64\n0 5\nCONNECTIVITY vtktypeint64\n0 1 2 3\n", SB_ERROR_FORMAT,
     0, 0, "offset"},
    {SB_FILE_VTK, VTK_TET "CELLS 2 4\nOFFSETS vtktypeint64\n0 4\nCONNECTIVITY float\n0 1 2 3\n", SB_ERROR_FORMAT, 0, -1,
     "float"},
    {SB_FILE_VTK, VTK_TET "CELLS 2 4\nOFFSETS vtktypeint64\n0 4\nCONNECTIVITY vtktypeint64\n0 1 2 4\n", SB_ERROR_INDEX,
     0, 0, "node 4"},
    {SB_FILE_VTK, VTK_TET VTK_CUBE, SB_ERROR_FORMAT, 0, -1, "second POINTS"},
    {SB_FILE_VTK, VTK_HEAD "UNSTRUCTURED_GRID\nCELLS 1 5\n4 0 1 2 3\n", SB_ERROR_FORMAT, 5, -1, "before POINTS"},
    {SB_FILE_VTK, VTK_HEAD "POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\nPOLYGONS 1 3\n2 0 1\n", SB_ERROR_FORMAT, 0, 0,
     "2 corners"},
    {SB_FILE_VTK, VTK_HEAD "POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\nLINES 1 3\n2 0 1\n", SB_ERROR_MESH, 0, -1,
     "no faces"},
    {SB_FILE_VTK,
     VTK_HEAD "UNSTRUCTURED_GRID\n" VTK_CUBE "CELLS 2 14\n4 0 1 2 4\n8 0 1 3 2 4 5 7 6\nCELL_TYPES 2\n10 12\n",
     SB_ERROR_UNSUPPORTED, 0, 1, "other diagonal"},
    {SB_FILE_VTK, VTK_HEAD "UNSTRUCTURED_GRID\n" VTK_CUBE "CELLS 2 12\n4 0 1 2 4\n6 0 1 2 4 5 6\nCELL_TYPES 2\n10 13\n",
     SB_ERROR_UNSUPPORTED, 0, 1, "other diagonal"},
    {SB_FILE_VTK, VTK_TET "CELLS 2 16\n4 0 1 2 3\n10 0 1 2 3 0 1 2 3 0 1\nCELL_TYPES 2\n10 24\n", SB_ERROR_UNSUPPORTED,
     0, 1, "tet4 and tet10"},
    {SB_FILE_VTK, VTK_TET "CELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n25\n", SB_ERROR_FORMAT, 10, 0, "a hex20 has 20"},
    {SB_FILE_VTK, VTK_TET "CELLS 1 5\n4 0 1 2 3\nCELL_TYPES 1\n29\n", SB_ERROR_FORMAT, 10, 0, "a hex27 has 27"},
    {SB_FILE_VTK, VTK_TET "CELLS 1 21\n20 0 1 2 3 0 1 2 3 0 1 2 3 0 1 2 3 0 1 2 3\nCELL_TYPES 1\n25\n", SB_ERROR_MESH,
     0, 0, "used twice"},
    {SB_FILE_VTK, VTK_TET "CELLS 1 21\n20 0 1 2 3 0 1 2 3 0 1 2 3 0 1 2 3 0 1 2 4\nCELL_TYPES 1\n25\n", SB_ERROR_INDEX,
     0, 0, "node 4"},
    {SB_FILE_GMSH, GMSH_HEAD GMSH_NODES "$Elements\n1\n1 17 2 0 0 1 2 3 4\n$EndElements\n", SB_ERROR_FORMAT, 0, 0, ""},
    {SB_FILE_GMSH, "$MeshFormat\n4.2 0 8\n$EndMeshFormat\n", SB_ERROR_UNSUPPORTED, 2, -1, "4.2"},
    {SB_FILE_GMSH, "$NOD\n1\n1 0 0 0\n$ENDNOD\n", SB_ERROR_FORMAT, 0, -1, "$Elements"},
    {SB_FILE_GMSH, GMSH_NODES, SB_ERROR_FORMAT, 1, -1, "$MeshFormat"},
    {SB_FILE_GMSH, GMSH_HEAD, SB_ERROR_FORMAT, 0, -1, "$Nodes"},
    {SB_FILE_GMSH, GMSH_HEAD GMSH_NODES, SB_ERROR_FORMAT, 0, -1, "$Elements"},
    {SB_FILE_GMSH, GMSH_HEAD "$Elements\n0\n$EndElements\n" GMSH_NODES, SB_ERROR_FORMAT, 4, -1, "before"},
    {SB_FILE_GMSH, GMSH_HEAD "$Nodes\n2\n1 0 0 0\n1 1 0 0\n$EndNodes\n", SB_ERROR_FORMAT, 0, -1, "number 1"},
    {SB_FILE_GMSH, GMSH_HEAD GMSH_NODES "$Elements\n1\n1 4 2 0 0 1 2 3 5\n$EndElements\n", SB_ERROR_INDEX, 13, 0, "5"},
    {SB_FILE_GMSH, GMSH_HEAD GMSH_NODES "$Elements\n1\n1 77 2 0 0 1 2 3 4\n$EndElements\n", SB_ERROR_UNSUPPORTED, 13, 0,
     "77"},
    {SB_FILE_GMSH, GMSH_HEAD GMSH_NODES "$Elements\n1\n1 4 2 0 0 1 2 3 4\n1 4 2 0 0 1 2 3 4\n$EndElements\n",
     SB_ERROR_FORMAT, 14, -1, "$EndElements"},
    {SB_FILE_GMSH, GMSH_HEAD GMSH_NODES "$Elements\n1\n1 4 -2 1 2 3 4\n$EndElements\n", SB_ERROR_FORMAT, 13, 0,
     "negative"},
    {SB_FILE_GMSH, GMSH_HEAD "$Whatever\n1 2 3\n", SB_ERROR_FORMAT, 0, -1, "$EndWhatever"},
    {SB_FILE_GMSH, GMSH4_HEAD "$PartitionedEntities\n", SB_ERROR_UNSUPPORTED, 4, -1, "artition"},
    {SB_FILE_GMSH, GMSH4_HEAD "$Nodes\n1 2 1 2\n3 1 0 1\n1\n0 0 0\n$EndNodes\n", SB_ERROR_FORMAT, 0, -1, "announced"},
    {SB_FILE_GMSH, GMSH4_HEAD "$Nodes\n1 1 1 1\n7 1 1 1\n1\n0 0 0\n$EndNodes\n", SB_ERROR_FORMAT, 6, -1, "dimension"},
    {SB_FILE_VTK, VTK_HEAD "POLYDATA\nPOINTS 1 bit\n0 0 0\n", SB_ERROR_UNSUPPORTED, 5, -1, "bit"},
    {SB_FILE_VTK, VTK_HEAD "POLYDATA\nPOINTS 3 int\n0 0 0 1 0 0 0 1 0\nCELLS 1 4\n3 0 1 2\n", SB_ERROR_FORMAT, 7, -1,
     "CELLS"},
    {SB_FILE_VTK, VTK_TET "POLYGONS 1 4\n3 0 1 2\n", SB_ERROR_FORMAT, 7, -1, "POLYDATA"},
    {SB_FILE_VTK, VTK_TET "CELL_TYPES 1\n10\n", SB_ERROR_FORMAT, 7, -1, "CELLS"},
    {SB_FILE_VTK, VTK_TET "POINT_DATA 4\nFIELD f 1\nnames 1 4 string\na\nb\n", SB_ERROR_FORMAT, 0, -1, "text array"},
    {SB_FILE_GMSH, GMSH_HEAD GMSH_HEAD, SB_ERROR_FORMAT, 4, -1, "second"},
    {SB_FILE_GMSH, GMSH_HEAD GMSH_NODES GMSH_NODES, SB_ERROR_FORMAT, 11, -1, "second"},
    {SB_FILE_GMSH, GMSH_HEAD GMSH_NODES "$Elements\n0\n$EndElements\n$Elements\n0\n$EndElements\n", SB_ERROR_FORMAT, 14,
     -1, "second"},
    {SB_FILE_GMSH, GMSH4_HEAD "$Entities\n0 0 0 0\n$EndEntities\n$Entities\n0 0 0 0\n$EndEntities\n", SB_ERROR_FORMAT,
     7, -1, "second"},
    {SB_FILE_OBJ, "v 0 0\n", SB_ERROR_FORMAT, 1, -1, "2 numbers"},
    {SB_FILE_OBJ, "v 0 0 0 0 0 0 0 0\n", SB_ERROR_FORMAT, 1, -1, "more than 7"},
    {SB_FILE_OBJ, "v 0 0 0\nv 1 0 0\nf 1 2\n", SB_ERROR_FORMAT, 3, 0, "2 corners"},
    {SB_FILE_OBJ, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -4\n", SB_ERROR_INDEX, 4, 0, "-4"},
    {SB_FILE_OBJ, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3/1/1/1\n", SB_ERROR_FORMAT, 4, 0, "3/1/1/1"},
    {SB_FILE_OBJ, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3/x\n", SB_ERROR_FORMAT, 4, 0, "3/x"},
    {SB_FILE_OBJ, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3//\n", SB_ERROR_FORMAT, 4, 0, "3//"},
    {SB_FILE_OBJ, "v 0 0 0\n1 2 3\n", SB_ERROR_FORMAT, 2, -1, "keyword"},
    {SB_FILE_STL, "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nendloop\n", SB_ERROR_FORMAT, 6,
     0, "vertex"},
    {SB_FILE_STL, "solid a\n", SB_ERROR_FORMAT, 0, -1, "endsolid"},
    {SB_FILE_STL, "solid a\nendsolid a\n", SB_ERROR_MESH, 0, -1, "no faces"},
    {SB_FILE_STL, "solid a\nvolume\n", SB_ERROR_FORMAT, 2, -1, "facet"},
    {SB_FILE_STL, "x", SB_ERROR_FORMAT, 0, -1, "neither"},
    {SB_FILE_PLY, "ply\nformat ascii 1.0\n", SB_ERROR_FORMAT, 0, -1, "header"},
    {SB_FILE_PLY, "ply\nelement vertex 1\nend_header\n", SB_ERROR_FORMAT, 0, -1, "format"},
    {SB_FILE_PLY, "ply\nformat binary 1.0\n", SB_ERROR_UNSUPPORTED, 2, -1, "binary"},
    {SB_FILE_PLY, "ply\nformat ascii 1.0\nproperty float x\n", SB_ERROR_FORMAT, 3, -1, "before"},
    {SB_FILE_PLY, "ply\nformat ascii 1.0\nelement vertex -1\n", SB_ERROR_FORMAT, 3, -1, "negative"},
    {SB_FILE_PLY, "ply\nformat ascii 1.0\nelement vertex 1\nproperty real x\n", SB_ERROR_FORMAT, 4, -1, "real"},
    {SB_FILE_PLY, "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n", SB_ERROR_FORMAT, 6, -1,
     "x, y and z"},
    {SB_FILE_PLY, "ply\nformat ascii 1.0\nelement face 1\nproperty list float int vertex_indices\n", SB_ERROR_FORMAT, 4,
     -1, "integer"},
    {SB_FILE_PLY, PLY_HEAD PLY_FACE "3 0 1 3\n", SB_ERROR_INDEX, 0, 0, "node 3"},
    {SB_FILE_PLY, PLY_HEAD PLY_FACE "-3 0 1 2\n", SB_ERROR_FORMAT, 0, 0, "negative"},
    {SB_FILE_PLY, PLY_HEAD PLY_FACE "3 0 1 2\n3 0 1 2\n", SB_ERROR_FORMAT, 0, -1, "behind"},
    {SB_FILE_PLY, PLY_HEAD "end_header\n0 0 0\n1 0 0\n0 1 0\n", SB_ERROR_MESH, 0, -1, "no faces"},
    {SB_FILE_OFF, "OFF BINARY\n", SB_ERROR_UNSUPPORTED, 1, -1, "binary"},
    {SB_FILE_OFF, "4OFF\n", SB_ERROR_UNSUPPORTED, 1, -1, "4OFF"},
    {SB_FILE_OFF, "OOF\n", SB_ERROR_FORMAT, 1, -1, "OOF"},
    {SB_FILE_OFF, "OFF\n3 1 0\n0 0 0 7\n1 0 0\n0 1 0\n3 0 1 2\n", SB_ERROR_FORMAT, 3, -1, "'7'"},
    {SB_FILE_OFF, "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 red\n", SB_ERROR_FORMAT, 6, 0, "red"},
    {SB_FILE_OFF, "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n3 0 1 2\n", SB_ERROR_FORMAT, 7, -1, "behind"},
    {SB_FILE_OFF, "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n0\n", SB_ERROR_FORMAT, 6, 0, "0 corners"}};

static void test_errors(void)
{
    for (size_t i = 0; i < sizeof bad_texts / sizeof bad_texts[0]; i++) {
        const struct bad_text *bad = &bad_texts[i];
        int failures = check.failures;
        sb_mesh mesh;
        sb_error error;
        CHECK_RESULT(load_text(&mesh, bad->text, bad->format, &error), bad->result);
        CHECK_INT(error.result, bad->result);
        if (bad->line)
            CHECK_INT(error.line, bad->line);
        CHECK_INT(error.element, bad->element);
        CHECK(strstr(error.message, bad->word) != NULL);
        CHECK(strcmp(error.file, "text") == 0);
        if (check.failures != failures)
            printf("  text %d, line %d: %s\n", (int)i, error.line, error.message);
        sb_mesh_free(&mesh);
    }
}

static void test_arguments(void)
{
    sb_mesh mesh;
    sb_error error;
    sb_load_options options = sb_default_load_options();
    const char *text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    char path[400];
    size_t size = strlen(text);
    memset(&mesh, 0, sizeof mesh);
    CHECK_RESULT(sb_mesh_load(NULL, "x.obj", NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_load(&mesh, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_load(&mesh, "/nonexistent/x.obj", NULL, &error), SB_ERROR_FILE);
    CHECK(strcmp(error.file, "/nonexistent/x.obj") == 0);
    CHECK_RESULT(sb_mesh_load(&mesh, "/tmp", NULL, &error), SB_ERROR_FILE);
    memset(path, 'a', sizeof path);
    memcpy(path + sizeof path - 7, "/x.obj", 7);
    CHECK_RESULT(sb_mesh_load(&mesh, path, NULL, &error), SB_ERROR_FILE);
    CHECK(strlen(error.file) == sizeof error.file - 1 && strstr(error.file, "a/x.obj"));
    CHECK_RESULT(sb_mesh_load_memory(NULL, text, size, SB_FILE_OBJ, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_load_memory(&mesh, NULL, 1, SB_FILE_OBJ, NULL, NULL, &error), SB_ERROR_ARGUMENT);
#ifndef __cplusplus /* where such a value cannot be written down */
    CHECK_RESULT(sb_mesh_load_memory(&mesh, text, size, (sb_file_format)10, NULL, NULL, &error), SB_ERROR_ARGUMENT);
#endif
    CHECK_RESULT(sb_mesh_load_memory(&mesh, NULL, 0, SB_FILE_OBJ, NULL, NULL, &error), SB_ERROR_FORMAT);
    check_bad_numbers();
    for (int i = 0; i < 4; i++) {
        static const sb_real scales[4] = {0, -1, (sb_real)NAN, (sb_real)INFINITY};
        options.scale = scales[i];
        CHECK_RESULT(sb_mesh_load_memory(&mesh, text, size, SB_FILE_OBJ, NULL, &options, &error), SB_ERROR_ARGUMENT);
    }
    memset(&options, 0, sizeof options);
    options.scale = 1;
    CHECK_RESULT(sb_mesh_load_memory(&mesh, text, size, SB_FILE_OBJ, NULL, &options, &error), SB_ERROR_ARGUMENT);
    options = sb_default_load_options();
    options.scale = (sb_real)0.001;
    CHECK_OK(sb_mesh_load_memory(&mesh, text, size, SB_FILE_OBJ, NULL, &options, NULL));
    CHECK(mesh.nodes && mesh.nodes[1].x == (sb_real)0.001);
    sb_mesh_free(&mesh);
    options.scale = SB_REAL_MAX;
    CHECK_RESULT(load_text(&mesh, "v 0 0 0\nv 1e9 0 0\nv 0 1 0\nf 1 2 3\n", SB_FILE_OBJ, &error), SB_OK);
    sb_mesh_free(&mesh);
    CHECK_RESULT(sb_mesh_load_memory(&mesh, "v 0 0 0\nv 1e9 0 0\n", 18, SB_FILE_OBJ, NULL, &options, &error),
                 SB_ERROR_NOT_FINITE);
}

/* All elements inverted: a convention, turned. Some of them: an error unless asked for. */
static void test_orientation(void)
{
    static const char all[] = VTK_TET "CELLS 1 5\n4 1 0 2 3\nCELL_TYPES 1\n10\n";
    static const char some[] = VTK_HEAD "UNSTRUCTURED_GRID\nPOINTS 5 float\n0 0 0 1 0 0 0 1 0 0 0 1 1 1 1\n"
                                        "CELLS 2 10\n4 0 1 2 3\n4 2 1 3 4\nCELL_TYPES 2\n10 10\n";
    static const char flat[] = VTK_TET "CELLS 2 10\n4 0 1 2 3\n4 1 0 2 1\nCELL_TYPES 2\n10 10\n";
    sb_load_report report;
    sb_load_options options = sb_default_load_options();
    sb_mesh mesh;
    sb_error error;
    options.report = &report;
    memset(&mesh, 0, sizeof mesh);
    CHECK_OK(sb_mesh_load_memory(&mesh, all, sizeof all - 1, SB_FILE_AUTO, NULL, &options, &error));
    CHECK_INT(report.flipped_elements, 1);
    CHECK_NEAR(sb_mesh_volume(&mesh), 1.0 / 6, SB_EPSILON);
    sb_mesh_free(&mesh);
    CHECK_RESULT(sb_mesh_load_memory(&mesh, some, sizeof some - 1, SB_FILE_AUTO, "s.vtk", &options, &error),
                 SB_ERROR_MESH);
    CHECK_INT(error.element, 1);
    CHECK(strcmp(error.file, "s.vtk") == 0);
    options.fix_orientation = 1;
    CHECK_OK(sb_mesh_load_memory(&mesh, some, sizeof some - 1, SB_FILE_AUTO, NULL, &options, &error));
    CHECK_INT(report.flipped_elements, 1);
    CHECK_NEAR(sb_mesh_volume(&mesh), 0.5, 2 * SB_EPSILON);
    sb_mesh_free(&mesh);
    CHECK_RESULT(sb_mesh_load_memory(&mesh, flat, sizeof flat - 1, SB_FILE_AUTO, NULL, &options, &error),
                 SB_ERROR_MESH);
    CHECK_OK(sb_mesh_load_memory(&mesh, "v 0 0 0\nv 0 1 0\nv 1 0 0\nv 0 0 1\nf 1 3 2\nf 1 4 2\nf 1 3 4\nf 2 3 4\n", 63,
                                 SB_FILE_OBJ, NULL, &options, &error));
    CHECK_NEAR(sb_mesh_volume(&mesh), 1.0 / 6, SB_EPSILON);
    sb_mesh_free(&mesh);
}

/* ---- the prepared files --------------------------------------------------------------------------- */

static const struct bad_file {
    const char *name;
    sb_result result;
    int nodes, elements; /* of a file that is read */
    double volume;       /* m^3 */
    int placed;          /* the error must tell a line, element or node */
} bad_files[] = {{"nonmanifold_edge_fin.obj", SB_OK, 163, 321, 0, 0},
                 {"nonmanifold_vertex_bowtie.obj", SB_OK, 323, 640, 0, 0},
                 {"open_surface.obj", SB_OK, 161, 308, 0, 0},
                 {"mixed_orientation.obj", SB_OK, 162, 320, 0, 0},
                 {"inside_out.obj", SB_OK, 162, 320, -5.05876e-4, 0},
                 {"self_intersecting.obj", SB_OK, 324, 640, 0, 0},
                 {"degenerate_triangle.obj", SB_OK, 162, 320, 0, 0},
                 {"nan_coordinate.obj", SB_ERROR_NOT_FINITE, 0, 0, 0, 1},
                 {"inf_coordinate.obj", SB_ERROR_NOT_FINITE, 0, 0, 0, 1},
                 {"face_index_out_of_range.obj", SB_ERROR_INDEX, 0, 0, 0, 1},
                 {"face_index_zero.obj", SB_ERROR_INDEX, 0, 0, 0, 1},
                 {"relative_indices_valid.obj", SB_OK, 4, 4, 1.0 / 6, 0},
                 {"polygons_slashes_crlf_valid.obj", SB_OK, 8, 12, 1, 0},
                 {"empty.obj", SB_ERROR_FORMAT, 0, 0, 0, 0},
                 {"no_faces.obj", SB_ERROR_MESH, 0, 0, 0, 0},
                 {"truncated_binary.stl", SB_ERROR_FORMAT, 0, 0, 0, 0},
                 {"binary_count_too_big.stl", SB_ERROR_FORMAT, 0, 0, 0, 0},
                 {"binary_starting_with_solid_valid.stl", SB_OK, 162, 320, 5.05876e-4, 0},
                 {"truncated_ascii.stl", SB_ERROR_FORMAT, 0, 0, 0, 1},
                 {"inverted_tets.vtk", SB_ERROR_MESH, 0, 0, 0, 1},
                 {"zero_volume_tet.vtk", SB_ERROR_MESH, 0, 0, 0, 1},
                 {"duplicate_nodes.vtk", SB_OK, 288, 72, 1.2e-5, 0},
                 {"duplicate_elements.vtk", SB_OK, 36, 77, 0, 0},
                 {"unreferenced_nodes.vtk", SB_OK, 38, 72, 1.2e-5, 0},
                 {"index_out_of_range.vtk", SB_ERROR_INDEX, 0, 0, 0, 1},
                 {"negative_index.vtk", SB_ERROR_INDEX, 0, 0, 0, 1},
                 {"repeated_node_in_tet.vtk", SB_ERROR_MESH, 0, 0, 0, 1},
                 {"base_valid.vtk", SB_OK, 36, 72, 1.2e-5, 0},
                 {"nan_coordinate.vtk", SB_ERROR_NOT_FINITE, 0, 0, 0, 1},
                 {"text_in_coordinate.vtk", SB_ERROR_FORMAT, 0, 0, 0, 1},
                 {"decimal_comma.vtk", SB_ERROR_FORMAT, 0, 0, 0, 1},
                 {"truncated_points.vtk", SB_ERROR_FORMAT, 0, 0, 0, 1},
                 {"truncated_cells.vtk", SB_ERROR_FORMAT, 0, 0, 0, 1},
                 {"missing_cell_types.vtk", SB_ERROR_FORMAT, 0, 0, 0, 1},
                 {"point_count_too_big.vtk", SB_ERROR_FORMAT, 0, 0, 0, 1},
                 {"point_count_too_small.vtk", SB_ERROR_FORMAT, 0, 0, 0, 1},
                 {"cell_size_wrong.vtk", SB_ERROR_FORMAT, 0, 0, 0, 1},
                 {"huge_count.vtk", SB_ERROR_FORMAT, 0, 0, 0, 1},
                 {"negative_count.vtk", SB_ERROR_FORMAT, 0, 0, 0, 1},
                 {"overflow_count.vtk", SB_ERROR_FORMAT, 0, 0, 0, 1},
                 {"wrong_cell_type.vtk", SB_ERROR_FORMAT, 0, 0, 0, 1},
                 {"header_only.vtk", SB_ERROR_FORMAT, 0, 0, 0, 0},
                 {"empty.vtk", SB_ERROR_FORMAT, 0, 0, 0, 0},
                 {"random_bytes.vtk", SB_ERROR_FORMAT, 0, 0, 0, 0},
                 {"long_line.vtk", SB_OK, 36, 72, 1.2e-5, 0},
                 {"tet10_base_valid.vtk", SB_OK, 175, 72, 1.2e-5, 0},
                 {"tet10_bad_midside.vtk", SB_ERROR_MESH, 0, 0, 0, 1},
                 {"tet10_gmsh_order.vtk", SB_ERROR_MESH, 0, 0, 0, 1},
                 {"hex8_inverted.vtk", SB_ERROR_MESH, 0, 0, 0, 1},
                 {"truncated_v41.msh", SB_ERROR_FORMAT, 0, 0, 0, 1},
                 {"no_end_tag.msh", SB_ERROR_FORMAT, 0, 0, 0, 1},
                 {"sparse_node_numbers_valid.msh", SB_OK, 4, 1, 1.0 / 6, 0},
                 {"unknown_version.msh", SB_ERROR_UNSUPPORTED, 0, 0, 0, 1},
                 {"two_components.vtk", SB_OK, 72, 144, 2.4e-5, 0}};

static void test_bad_files(void)
{
    char path[512], name[128];
    for (size_t i = 0; i < sizeof bad_files / sizeof bad_files[0]; i++) {
        const struct bad_file *bad = &bad_files[i];
        int failures = check.failures;
        sb_mesh mesh;
        sb_error error;
        memset(&mesh, 0, sizeof mesh);
        memset(&error, 0, sizeof error);
        error.element = error.node = -1;
        snprintf(name, sizeof name, "data/bad/%s", bad->name);
        if (!check_shared_path(path, sizeof path, name)) {
            CHECK_SKIP("the shared data is not there");
            return;
        }
        CHECK_RESULT(sb_mesh_load(&mesh, path, NULL, &error), bad->result);
        CHECK_INT(mesh.node_count, bad->nodes);
        CHECK_INT(mesh.element_count, bad->elements);
        if (bad->volume != 0)
            CHECK_NEAR(sb_mesh_volume(&mesh), bad->volume, 1e-5 * fabs(bad->volume));
        if (bad->result)
            CHECK(error.message[0] && strcmp(error.file, path) == 0);
        if (bad->placed)
            CHECK(error.line > 0 || error.element >= 0 || error.node >= 0);
        if (check.failures != failures)
            printf("  in %s: line %d, element %d, node %d: %s\n", bad->name, error.line, error.element, error.node,
                   error.message);
        sb_mesh_free(&mesh);
    }
}

/* The elements that are named; see the table of the folder. */
static void test_bad_elements(void)
{
    static const struct {
        const char *name;
        int element;
        const char *words[3];
    } files[] = {{"data/bad/inverted_tets.vtk", 3, {"3", "17", "40"}},
                 {"data/bad/hex8_inverted.vtk", 4, {"4", "", ""}},
                 {"data/bad/zero_volume_tet.vtk", 72, {"72", "", ""}},
                 {"data/bad/repeated_node_in_tet.vtk", 71, {"71", "", ""}}};
    char path[512];
    for (size_t i = 0; i < sizeof files / sizeof files[0]; i++) {
        sb_mesh mesh;
        sb_error error;
        if (!check_shared_path(path, sizeof path, files[i].name)) {
            CHECK_SKIP("the shared data is not there");
            return;
        }
        CHECK_RESULT(sb_mesh_load(&mesh, path, NULL, &error), SB_ERROR_MESH);
        CHECK_INT(error.element, files[i].element);
        for (int k = 0; k < 3; k++)
            CHECK(strstr(error.message, files[i].words[k]) != NULL);
    }
    if (check_shared_path(path, sizeof path, "data/bad/inverted_tets.vtk")) {
        sb_load_options options = sb_default_load_options();
        sb_load_report report;
        sb_mesh mesh;
        options.fix_orientation = 1;
        options.report = &report;
        if (CHECK_OK(sb_mesh_load(&mesh, path, &options, NULL))) {
            CHECK_INT(report.flipped_elements, 3);
            CHECK_NEAR(sb_mesh_volume(&mesh), 1.2e-5, 1e-4 * 1.2e-5);
            sb_mesh_free(&mesh);
        }
    }
}

/* Node and element counts as the data's table has them; volume and area in cm^3 and cm^2 where it tells
 * them. */
static const struct good_file {
    const char *name;
    sb_element_type type;
    int nodes, elements;
    double volume, area;
} good_files[] = {{"volumes/liver_a_tet4_2k.vtk", SB_TET4, 598, 2008, 0, 0},
                  {"volumes/liver_a_tet4_10k.vtk", SB_TET4, 2361, 9777, 0, 0},
                  {"volumes/liver_a_tet4_40k.vtk", SB_TET4, 8716, 41217, 0, 0},
                  {"volumes/liver_a_tet10_1k.vtk", SB_TET10, 2056, 1062, 0, 0},
                  {"volumes/liver_a_tet10_3k.vtk", SB_TET10, 5550, 3147, 0, 0},
                  {"volumes/liver_a_tet10_9k.vtk", SB_TET10, 14758, 9026, 0, 0},
                  {"volumes/liver_b_tet4_10k.vtk", SB_TET4, 2146, 9107, 0, 0},
                  {"volumes/liver_b_tet10_3k.vtk", SB_TET10, 4945, 2873, 0, 0},
                  {"volumes/bunny_tet4.vtk", SB_TET4, 1911, 5897, 0, 0},
                  {"volumes/armadillo_tet4.vtk", SB_TET4, 1446, 4406, 0, 0},
                  {"volumes/beam_caribou_tet4.vtk", SB_TET4, 81, 192, 18, 0},
                  {"volumes/beam_caribou_tet10.vtk", SB_TET10, 425, 192, 18, 0},
                  {"volumes/beam_caribou_hex8.vtk", SB_HEX8, 81, 32, 18, 0},
                  {"volumes/beam_caribou_hex20.vtk", SB_HEX20, 261, 32, 18, 0},
                  {"volumes/beam_hex20.vtk", SB_HEX20, 321, 40, 40, 0},
                  {"volumes/cylinder_hex20.vtk", SB_HEX20, 2341, 480, 0, 0},
                  {"volumes/cylinder_caribou_tet4.vtk", SB_TET4, 221, 558, 0, 0},
                  {"volumes/beam_tet4.vtk", SB_TET4, 99, 240, 40, 0},
                  {"volumes/cylinder_tet4.vtk", SB_TET4, 408, 1388, 0, 0},
                  {"volumes/beam_tet10.vtk", SB_TET10, 525, 240, 40, 0},
                  {"volumes/cylinder_tet10.vtk", SB_TET10, 2517, 1388, 0, 0},
                  {"volumes/beam_hex8.vtk", SB_HEX8, 99, 40, 40, 0},
                  {"volumes/cylinder_hex8.vtk", SB_HEX8, 627, 480, 0, 0},
                  {"volumes/liver_a_tet4_10k.msh", SB_TET4, 2361, 9777, 0, 0},
                  {"volumes/liver_a_tet4_2k_v41.msh", SB_TET4, 598, 2008, 0, 0},
                  {"volumes/liver_a_tet10_2k.msh", SB_TET10, 3673, 2008, 0, 0},
                  {"surfaces/liver_a.obj", SB_TRI3, 2194, 4384, 1500.00, 891.32},
                  {"surfaces/liver_a.stl", SB_TRI3, 2194, 4384, 1500.00, 891.32},
                  {"surfaces/liver_a.vtk", SB_TRI3, 2194, 4384, 1500.00, 891.32},
                  {"surfaces/liver_a_binary.stl", SB_TRI3, 2194, 4384, 1500.00, 891.32},
                  {"surfaces/liver_b.obj", SB_TRI3, 1170, 2336, 1400.00, 744.83},
                  {"surfaces/liver_b.stl", SB_TRI3, 1170, 2336, 1400.00, 744.83},
                  {"surfaces/liver_b.vtk", SB_TRI3, 1170, 2336, 1400.00, 744.83},
                  {"surfaces/liver_a_uniform_coarse.obj", SB_TRI3, 808, 1612, 1480.57, 874.36},
                  {"surfaces/liver_a_uniform_coarse.stl", SB_TRI3, 808, 1612, 1480.57, 874.36},
                  {"surfaces/liver_a_uniform_coarse.vtk", SB_TRI3, 808, 1612, 1480.57, 874.36},
                  {"surfaces/liver_a_uniform_fine.obj", SB_TRI3, 4504, 9004, 1496.46, 886.28},
                  {"surfaces/liver_a_uniform_fine.stl", SB_TRI3, 4504, 9004, 1496.46, 886.28},
                  {"surfaces/liver_a_uniform_fine.vtk", SB_TRI3, 4504, 9004, 1496.46, 886.28},
                  {"surfaces/bunny.obj", SB_TRI3, 1366, 2728, 218.32, 238.27},
                  {"surfaces/bunny.stl", SB_TRI3, 1366, 2728, 218.32, 238.27},
                  {"surfaces/bunny.vtk", SB_TRI3, 1366, 2728, 218.32, 238.27},
                  {"surfaces/bunny_binary.stl", SB_TRI3, 1366, 2728, 218.32, 238.27},
                  {"surfaces/torus.obj", SB_TRI3, 800, 1600, 69.96, 139.66},
                  {"surfaces/torus.stl", SB_TRI3, 800, 1600, 69.96, 139.66},
                  {"surfaces/torus.vtk", SB_TRI3, 800, 1600, 69.96, 139.66}};

static void test_good_files(void)
{
    char path[512], name[128];
    for (size_t i = 0; i < sizeof good_files / sizeof good_files[0]; i++) {
        const struct good_file *good = &good_files[i];
        int failures = check.failures;
        sb_mesh mesh;
        sb_error error;
        snprintf(name, sizeof name, "data/%s", good->name);
        if (!check_shared_path(path, sizeof path, name)) {
            CHECK_SKIP("the shared data is not there");
            return;
        }
        if (CHECK_OK(sb_mesh_load(&mesh, path, NULL, &error))) {
            CHECK_INT(mesh.element_type, good->type);
            CHECK_INT(mesh.node_count, good->nodes);
            CHECK_INT(mesh.element_count, good->elements);
            if (good->volume != 0)
                CHECK_NEAR((double)sb_mesh_volume(&mesh) * 1e6, good->volume, 0.006);
            if (good->area != 0)
                CHECK_NEAR((double)sb_mesh_surface_area(&mesh) * 1e4, good->area, 0.006);
            CHECK(mesh.regions == NULL);
            CHECK_OK(sb_mesh_validate(&mesh, NULL));
            sb_mesh_free(&mesh);
        }
        if (check.failures != failures)
            printf("  in %s: %s\n", good->name, error.message);
    }
}

/* The same mesh in two formats; gmsh's tet10 against straight tet10 (a wrong node order folds elements). */
static void test_same_mesh(void)
{
    char path[512];
    sb_mesh vtk, msh;
    sb_load_report report;
    sb_load_options options = sb_default_load_options();
    options.report = &report;
    if (!check_shared_path(path, sizeof path, "data/volumes/liver_a_tet4_10k.msh")) {
        CHECK_SKIP("the shared data is not there");
        return;
    }
    CHECK_OK(sb_mesh_load(&msh, path, &options, NULL));
    CHECK_INT(report.skipped_cells, 12555 - 9777);
    CHECK(check_shared_path(path, sizeof path, "data/volumes/liver_a_tet4_10k.vtk"));
    CHECK_OK(sb_mesh_load(&vtk, path, NULL, NULL));
    CHECK(memcmp(vtk.elements, msh.elements, sizeof(int) * 4 * 9777) == 0);
    for (int i = 0; i < vtk.node_count; i++)
        if (!CHECK(sb_v3_norm(sb_v3_sub(vtk.nodes[i], msh.nodes[i])) < (sb_real)1e-7))
            break;
    sb_mesh_free(&vtk);
    sb_mesh_free(&msh);
}

static void test_phantom_regions(void)
{
    static const char *const names[2] = {"data/phantom/phantom_tet4.vtk", "data/phantom/phantom_tet10.vtk"};
    static const int elements[2] = {7092, 2557};
    char path[512];
    for (int i = 0; i < 2; i++) {
        sb_mesh mesh;
        double volume[3] = {0, 0, 0};
        if (!check_shared_path(path, sizeof path, names[i])) {
            CHECK_SKIP("the shared data is not there");
            return;
        }
        if (!CHECK_OK(sb_mesh_load(&mesh, path, NULL, NULL)))
            return;
        CHECK_INT(mesh.element_count, elements[i]);
        if (CHECK(mesh.regions != NULL))
            for (int e = 0; e < mesh.element_count; e++) {
                int region = mesh.regions[e];
                if (CHECK(region == 1 || region == 2))
                    volume[region] += (double)sb_mesh_element_volume(&mesh, e);
            }
        /* an ellipsoid with semi-axes 22.5, 17.5 and 15 mm, cut into flat facets */
        CHECK_NEAR(volume[2] * 1e6, 4.0 / 3 * 3.14159265 * 2.25 * 1.75 * 1.5, 2);
        CHECK(volume[1] > 0.9e-3);
        sb_mesh_free(&mesh);
    }
}

/* ---- writers -------------------------------------------------------------------------------------- */

/* A mesh with awkward coordinates on the node table of a type; the elements need not be sound for writing. */
static void fill_mesh(sb_mesh *mesh, sb_element_type type, int nodes, int elements, sb_vec3 *x, int *cells,
                      unsigned long long *state)
{
    int per = sb_element_node_count(type);
    memset(mesh, 0, sizeof *mesh);
    mesh->element_type = type;
    mesh->node_count = nodes;
    mesh->element_count = elements;
    mesh->nodes = x;
    mesh->elements = cells;
    for (int i = 0; i < nodes; i++)
        x[i] = sb_v3((sb_real)check_random_in(state, -1, 1), (sb_real)(check_random(state) * 1e-30),
                     (sb_real)(check_random(state) * 1e30));
    for (int i = 0; i < elements * per; i++)
        cells[i] = (i % per + i / per) % nodes;
}

static int same_nodes(const sb_mesh *a, const sb_mesh *b)
{
    return a->node_count == b->node_count && memcmp(a->nodes, b->nodes, sizeof(sb_vec3) * (size_t)a->node_count) == 0;
}

static int same_elements(const sb_mesh *a, const sb_mesh *b)
{
    return a->element_type == b->element_type && a->element_count == b->element_count &&
           memcmp(a->elements, b->elements,
                  sizeof(int) * (size_t)a->element_count * (size_t)sb_element_node_count(a->element_type)) == 0;
}

/* A locale with a decimal comma changes neither reading nor writing. */
static void test_locale(void)
{
    static const char *const names[] = {"de_DE.UTF-8", "de_DE.utf8", "de_DE", "fr_FR.UTF-8", "nl_NL.UTF-8", "German"};
    int found = 0;
    for (size_t i = 0; i < sizeof names / sizeof names[0] && !found; i++)
        found = setlocale(LC_NUMERIC, names[i]) && localeconv()->decimal_point[0] == ',';
    if (!found) {
        CHECK_SKIP("no locale with a decimal comma is installed");
    } else {
        double a = read_number("0.5"), b = read_number("1.23456789012345678901234e-20"), c = read_number("0,5");
        sb_mesh mesh, loaded;
        CHECK_OK(load_text(&mesh, "v 0.1 1e-5 1e20\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", SB_FILE_OBJ, NULL));
        CHECK_OK(sb_mesh_save_vtk(temporary(".vtk"), &mesh, NULL, 0, NULL));
        setlocale(LC_NUMERIC, "C");
        if (CHECK_OK(sb_mesh_load(&loaded, temporary(".vtk"), NULL, NULL))) {
            CHECK(same_nodes(&mesh, &loaded));
            sb_mesh_free(&loaded);
        }
        remove(temporary(".vtk"));
        sb_mesh_free(&mesh);
        CHECK(a == 0.5);
        CHECK(b == (double)(sb_real)1.23456789012345678901234e-20);
        CHECK(!(c < 1));
    }
    setlocale(LC_NUMERIC, "C");
}

/* Surfaces come back bit by bit through every surface format, and through VTK. */
static void test_round_trip_surfaces(void)
{
    static const sb_element_type types[5] = {SB_TRI3, SB_QUAD4, SB_TRI6, SB_QUAD8, SB_QUAD9};
    static const char *const endings[5] = {".vtk", "_b.vtk", ".obj", ".ply", ".stl"};
    unsigned long long state = 12345;
    for (int i = 0; i < 5 * 5; i++) {
        sb_vec3 x[11];
        int cells[5 * 9], regions[5] = {0, 4, -1, 2147483647, 4}, format = i % 5;
        sb_mesh mesh, loaded;
        sb_error error;
        const char *path = temporary(endings[format]);
        sb_result result;
        fill_mesh(&mesh, types[i / 5], i < 15 ? 7 : 11, 5, x, cells, &state);
        mesh.regions = regions;
        if (format < 2)
            result = format ? sb_mesh_save_vtk_binary(path, &mesh, NULL, 0, &error)
                            : sb_mesh_save_vtk(path, &mesh, NULL, 0, &error);
        else if (format == 2)
            result = sb_mesh_save_obj(path, &mesh, &error);
        else
            result = format == 3 ? sb_mesh_save_ply(path, &mesh, &error) : sb_mesh_save_stl(path, &mesh, &error);
        if (i >= 10 && format >= 2) { /* curved */
            CHECK_RESULT(result, SB_ERROR_UNSUPPORTED);
            CHECK(!file_exists(path));
            continue;
        }
        if (!CHECK_OK(result) || !CHECK_OK(sb_mesh_load(&loaded, path, NULL, &error))) {
            printf("  %s: %s\n", endings[format], error.message);
            remove(path);
            continue;
        }
        if (format < 4)
            CHECK(same_nodes(&mesh, &loaded));
        if (format < 2) {
            CHECK(same_elements(&mesh, &loaded));
            CHECK(loaded.regions && memcmp(loaded.regions, regions, sizeof regions) == 0);
        } else if (types[i / 5] == SB_TRI3) {
            CHECK(same_elements(&mesh, &loaded) || format == 4);
        } else {
            CHECK_INT(loaded.element_type, SB_TRI3);
            CHECK_INT(loaded.element_count, 10);
        }
        if (format == 4)
            for (int e = 0; e < 5 && types[i / 5] == SB_TRI3; e++)
                for (int k = 0; k < 3; k++)
                    CHECK((float)loaded.nodes[loaded.elements[3 * e + k]].x == (float)x[cells[3 * e + k]].x &&
                          (float)loaded.nodes[loaded.elements[3 * e + k]].z == (float)x[cells[3 * e + k]].z);
        sb_mesh_free(&loaded);
        remove(path);
    }
}

/* Volumes need sound elements: those of the shared files, and the pair. */
static void test_round_trip_volumes(void)
{
    static const char *const names[3] = {"data/volumes/beam_hex8.vtk", "data/volumes/cylinder_tet10.vtk",
                                         "data/phantom/phantom_tet4.vtk"};
    char path[512];
    for (int i = 0; i < 6; i++) {
        sb_mesh mesh, loaded;
        const char *copy = temporary(".vtk");
        if (!check_shared_path(path, sizeof path, names[i / 2])) {
            CHECK_SKIP("the shared data is not there");
            return;
        }
        if (!CHECK_OK(sb_mesh_load(&mesh, path, NULL, NULL)))
            return;
        CHECK_OK(i % 2 ? sb_mesh_save_vtk_binary(copy, &mesh, NULL, 0, NULL)
                       : sb_mesh_save_vtk(copy, &mesh, NULL, 0, NULL));
        if (CHECK_OK(sb_mesh_load(&loaded, copy, NULL, NULL))) {
            CHECK(same_nodes(&mesh, &loaded) && same_elements(&mesh, &loaded));
            CHECK((mesh.regions != NULL) == (loaded.regions != NULL));
            if (mesh.regions && loaded.regions)
                CHECK(memcmp(mesh.regions, loaded.regions, sizeof(int) * (size_t)mesh.element_count) == 0);
            sb_mesh_free(&loaded);
        }
        CHECK_RESULT(sb_mesh_save_obj(copy, &mesh, NULL), SB_ERROR_UNSUPPORTED);
        CHECK_RESULT(sb_mesh_save_stl(copy, &mesh, NULL), SB_ERROR_UNSUPPORTED);
        CHECK_RESULT(sb_mesh_save_ply(copy, &mesh, NULL), SB_ERROR_UNSUPPORTED);
        remove(copy);
        sb_mesh_free(&mesh);
    }
}

/* Quadratic hexes of our own making, curved, come back to the last bit. */
static void test_round_trip_hexes(void)
{
    for (int i = 0; i < 4; i++) {
        sb_mesh mesh, loaded;
        const char *path = temporary(".vtk");
        CHECK_OK(sb_mesh_beam(i < 2 ? SB_HEX20 : SB_HEX27, 3, 2, 2, sb_v3(3, 2, 2), NULL, &mesh, NULL));
        for (int v = 0; v < mesh.node_count; v++)
            mesh.nodes[v].x += (sb_real)0.1 * mesh.nodes[v].z * mesh.nodes[v].z;
        CHECK_OK(i % 2 ? sb_mesh_save_vtk_binary(path, &mesh, NULL, 0, NULL)
                       : sb_mesh_save_vtk(path, &mesh, NULL, 0, NULL));
        if (CHECK_OK(sb_mesh_load(&loaded, path, NULL, NULL))) {
            CHECK(same_nodes(&mesh, &loaded) && same_elements(&mesh, &loaded));
            CHECK_NEAR(sb_mesh_volume(&loaded), 12, 12 * 64 * SB_EPSILON);
            sb_mesh_free(&loaded);
        }
        remove(path);
        sb_mesh_free(&mesh);
    }
}

/* The text of a file with fields of every shape. */
static void test_fields(void)
{
    static const int components[6] = {1, 2, 3, 4, 6, 9};
    unsigned long long state = 99;
    sb_vec3 x[5];
    int cells[2 * 4], regions[2] = {3, 7};
    sb_real values[6 * 5 * 9];
    char names[12][16];
    static char text[20000];
    sb_field fields[12];
    sb_mesh mesh, loaded;
    sb_error error;
    fill_mesh(&mesh, SB_QUAD4, 5, 2, x, cells, &state);
    mesh.regions = regions;
    for (size_t i = 0; i < sizeof values / sizeof values[0]; i++)
        values[i] = (sb_real)i;
    for (int i = 0; i < 12; i++) {
        snprintf(names[i], sizeof names[i], "f%d_%d", components[i % 6], i / 6);
        fields[i].name = names[i];
        fields[i].location = i < 6 ? SB_FIELD_NODES : SB_FIELD_ELEMENTS;
        fields[i].components = components[i % 6];
        fields[i].values = values;
    }
    for (int binary = 0; binary < 2; binary++) {
        const char *path = temporary(".vtk");
        CHECK_OK(binary ? sb_mesh_save_vtk_binary(path, &mesh, fields, 12, &error)
                        : sb_mesh_save_vtk(path, &mesh, fields, 12, &error));
        if (CHECK_OK(sb_mesh_load(&loaded, path, NULL, &error))) {
            CHECK(same_nodes(&mesh, &loaded) && same_elements(&mesh, &loaded));
            CHECK(loaded.regions && loaded.regions[1] == 7);
            sb_mesh_free(&loaded);
        }
        if (!binary) {
            FILE *file = fopen(path, "rb");
            size_t size = file ? fread(text, 1, sizeof text - 1, file) : 0;
            text[size] = 0;
            if (file)
                fclose(file);
            CHECK(strstr(text, "POINT_DATA 5") && strstr(text, "CELL_DATA 2") && strstr(text, "SCALARS region int 1"));
            CHECK(strstr(text, "VECTORS f3_0 ") && strstr(text, "SCALARS f2_1 ") && strstr(text, "TENSORS f9_1 "));
            /* xx yy zz xy yz xz becomes a full matrix */
            CHECK(strstr(text, "\n0 3 5 3 1 4 5 4 2\n6 9 11 9 7 10 11 10 8\n") != NULL);
        }
        remove(path);
    }
}

static void test_writer_errors(void)
{
    unsigned long long state = 5;
    sb_vec3 x[3];
    int cells[3], regions[1] = {1};
    sb_real value[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
    sb_mesh mesh;
    sb_error error;
    sb_field field;
    const char *path = temporary("_e.vtk");
    fill_mesh(&mesh, SB_TRI3, 3, 1, x, cells, &state);
    field.name = "f";
    field.location = SB_FIELD_ELEMENTS;
    field.components = 1;
    field.values = value;
    CHECK_RESULT(sb_mesh_save_vtk(NULL, &mesh, NULL, 0, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_save_vtk(path, NULL, NULL, 0, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_save_vtk(path, &mesh, NULL, 1, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_save_vtk(path, &mesh, &field, -1, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_save_obj(path, NULL, &error), SB_ERROR_ARGUMENT);
    field.components = 5;
    CHECK_RESULT(sb_mesh_save_vtk(path, &mesh, &field, 1, &error), SB_ERROR_ARGUMENT);
    field.components = 1;
    field.name = "two words";
    CHECK_RESULT(sb_mesh_save_vtk(path, &mesh, &field, 1, &error), SB_ERROR_ARGUMENT);
    field.name = "";
    CHECK_RESULT(sb_mesh_save_vtk(path, &mesh, &field, 1, &error), SB_ERROR_ARGUMENT);
    field.name = "region";
    mesh.regions = regions;
    CHECK_RESULT(sb_mesh_save_vtk(path, &mesh, &field, 1, &error), SB_ERROR_ARGUMENT);
    field.name = "f";
    value[0] = (sb_real)NAN;
    CHECK_RESULT(sb_mesh_save_vtk(path, &mesh, &field, 1, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.element, 0);
    cells[1] = 3;
    CHECK_RESULT(sb_mesh_save_vtk(path, &mesh, NULL, 0, &error), SB_ERROR_INDEX);
    CHECK_RESULT(sb_mesh_save_stl(path, &mesh, &error), SB_ERROR_INDEX);
    cells[1] = 1;
    x[2].y = (sb_real)INFINITY;
    CHECK_RESULT(sb_mesh_save_ply(path, &mesh, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.node, 2);
#if !SB_REAL_IS_FLOAT
    x[2].y = 1e39;
    CHECK_RESULT(sb_mesh_save_stl(path, &mesh, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.node, 2);
#endif
    x[2].y = 1;
    CHECK(!file_exists(path));
    CHECK_RESULT(sb_mesh_save_obj("/nonexistent/a.obj", &mesh, &error), SB_ERROR_FILE);
    CHECK(strcmp(error.file, "/nonexistent/a.obj") == 0);
    if (SBT_HAS_DEV_FULL && file_exists("/dev/full")) {
        CHECK_RESULT(sb_mesh_save_vtk("/dev/full", &mesh, NULL, 0, &error), SB_ERROR_FILE);
        CHECK_RESULT(sb_mesh_save_stl("/dev/full", &mesh, &error), SB_ERROR_FILE);
        CHECK(file_exists("/dev/full"));
    } else {
        CHECK_SKIP("there is no /dev/full");
    }
}

/* ---- memory --------------------------------------------------------------------------------------- */

typedef struct ration {
    int left; /* allocations until one fails; < 0: never */
    int live;
    size_t largest; /* request */
} ration;

static void *ration_alloc(void *user, size_t size)
{
    ration *r = (ration *)user;
    void *pointer;
    if (r->left == 0)
        return NULL;
    if (r->left > 0)
        r->left--;
    if (size > r->largest)
        r->largest = size;
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

/* Lets allocation 0, 1, 2, ... fail until a load succeeds; the mesh is untouched by the failures. */
static void check_rationed(const bytes *b, const char *path)
{
    int left, done = 0;
    for (left = 0; left < 200 && !done; left++) {
        ration r;
        sb_load_report report;
        sb_load_options options = rationed(&r, left);
        sb_mesh mesh, before;
        sb_error error;
        sb_result result;
        memset(&mesh, 0x5a, sizeof mesh);
        memcpy(&before, &mesh, sizeof mesh);
        options.report = &report;
        result = b ? sb_mesh_load_memory(&mesh, b->data, b->size, SB_FILE_AUTO, NULL, &options, &error)
                   : sb_mesh_load(&mesh, path, &options, &error);
        done = result == SB_OK;
        if (!done) {
            CHECK_RESULT(result, SB_ERROR_MEMORY);
            CHECK_INT(error.result, SB_ERROR_MEMORY);
            CHECK(memcmp(&mesh, &before, sizeof mesh) == 0);
        } else {
            sb_mesh_free(&mesh);
        }
        CHECK_INT(r.live, 0);
    }
    CHECK(done && left > 3);
}

static void test_memory_failures(void)
{
    static const char inverted[] = VTK_TET "CELLS 1 5\n4 1 0 2 3\nCELL_TYPES 1\n10\n";
    bytes b = {NULL, 0, 0, 0};
    for (int i = 0; i < SEED_COUNT; i++) {
        seeds[i].build(&b);
        check_rationed(&b, NULL);
        bytes_free(&b);
    }
    put_text(&b, inverted);
    check_rationed(&b, NULL);
    write_file(temporary(".vtk"), b.data, b.size);
    check_rationed(NULL, temporary(".vtk"));
    remove(temporary(".vtk"));
    bytes_free(&b);
    write_file(temporary(".node"), TETGEN_NODES, sizeof TETGEN_NODES - 1);
    write_file(temporary(".ele"), TETGEN_CELLS, sizeof TETGEN_CELLS - 1);
    check_rationed(NULL, temporary(".ele"));
    remove(temporary(".node"));
    remove(temporary(".ele"));
}

/* Counts that promise more than the file holds: an error before memory is taken. */
static void test_huge_counts(void)
{
    static const char *const texts[] = {
        VTK_HEAD "POLYDATA\nPOINTS 2000000000 float\n0 0 0\n",
        VTK_HEAD "POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\nPOLYGONS 2000000000 2000000000\n3 0 1 2\n",
        VTK_HEAD "POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 0\nPOLYGONS 2 2000000000\nOFFSETS int\n0 3\n",
        "# vtk DataFile Version 3.0\nt\nBINARY\nDATASET POLYDATA\nPOINTS 2000000000 float\n0000000000",
        GMSH_HEAD "$Nodes\n2000000000\n1 0 0 0\n",
        GMSH_HEAD GMSH_NODES "$Elements\n2000000000\n1 2 0 1 2 3\n",
        GMSH4_HEAD "$Nodes\n2000000000 2000000000 1 1\n3 1 0 2000000000\n",
        GMSH4_HEAD "$Nodes\n1 1 1 1\n3 1 0 2000000000\n1\n0 0 0\n",
        GMSH4_HEAD "$Entities\n2000000000 0 0 0\n",
        PLY_HEAD "element face 2000000000\nproperty list uchar int vertex_indices\nend_header\n0 0 0 1 0 0 0 1 0\n",
        "OFF\n2000000000 1 0\n0 0 0\n",
        "OFF\n1 2000000000 0\n0 0 0\n",
        "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n2000000000 0 1 2\n"};
    for (size_t i = 0; i < sizeof texts / sizeof texts[0]; i++) {
        ration r;
        sb_load_options options = rationed(&r, -1);
        sb_mesh mesh;
        CHECK_RESULT(sb_mesh_load_memory(&mesh, texts[i], strlen(texts[i]), SB_FILE_AUTO, NULL, &options, NULL),
                     SB_ERROR_FORMAT);
        CHECK(r.largest < 10000);
        CHECK_INT(r.live, 0);
    }
}

/* Files made to be slow: many blank lines, a polygon of very many corners, equal vertices, scattered node
 * numbers. */
static void test_no_slow_files(void)
{
    enum { MANY = 60000 };
    char line[80];
    clock_t start = clock();
    for (int kind = 0; kind < 4; kind++) {
        bytes b = {NULL, 0, 0, 0};
        sb_mesh mesh;
        memset(&mesh, 0, sizeof mesh);
        put_text(&b, kind == 0   ? "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
                     : kind == 1 ? "v 0 0 0\nv 1 0 0\nv 0 1 0\nf"
                     : kind == 2 ? "solid a\n"
                                 : GMSH_HEAD "$Nodes\n60000\n");
        for (int i = 0; i < MANY; i++) {
            if (kind == 1)
                snprintf(line, sizeof line, " %d", i % 3 + 1);
            else
                snprintf(line, sizeof line, "%lld 0 0 0\n", ((long long)i * 48271 % 65537 + 1) * 30000);
            put_text(&b, kind == 0   ? "\n"
                         : kind == 2 ? "facet normal 0 0 0 outer loop vertex 0 0 0 vertex 1 0 0 vertex 0 1 0 "
                                       "endloop endfacet\n"
                                     : line);
        }
        put_text(&b, kind == 0   ? "f 1 2 3\n"
                     : kind == 1 ? "\n"
                     : kind == 2 ? "endsolid\n"
                                 : "$EndNodes\n$Elements\n1\n1 2 2 0 0 30000 30000 30000\n$EndElements\n");
        CHECK_OK(sb_mesh_load_memory(&mesh, b.data, b.size, SB_FILE_AUTO, NULL, NULL, NULL));
        CHECK_INT(mesh.element_count, kind == 1 ? MANY - 2 : kind == 2 ? MANY : 1);
        CHECK_INT(mesh.node_count, kind == 3 ? MANY : 3);
        sb_mesh_free(&mesh);
        bytes_free(&b);
    }
    CHECK((double)(clock() - start) / CLOCKS_PER_SEC < 20); /* quadratic: minutes */
}

/* ---- mutations ------------------------------------------------------------------------------------ */

static size_t random_below(unsigned long long *state, size_t limit)
{
    size_t value = (size_t)(check_random(state) * (double)limit);
    return value < limit ? value : 0;
}

/* Replaces size bytes at `at` by others. */
static void splice(bytes *b, size_t at, size_t size, const void *with, size_t with_size)
{
    bytes result = {NULL, 0, 0, 0};
    put(&result, b->data, at);
    put(&result, with, with_size);
    put(&result, b->data + at + size, b->size - at - size);
    free(b->data);
    *b = result;
}

static void mutate_number(bytes *b, unsigned long long *state)
{
    static const char *const numbers[] = {
        "-1",          "0",   "4000000000", "99999999999999999999999", "nan", "-inf", "1e999", "2147483647",
        "-2147483648", "0.5", "1e-320",     "9223372036854775807",     "x",   ""};
    const char *number = numbers[random_below(state, sizeof numbers / sizeof numbers[0])];
    size_t at = random_below(state, b->size), end;
    while (at < b->size && (b->data[at] < '0' || b->data[at] > '9'))
        at++;
    end = at;
    while (end < b->size && b->data[end] > ' ')
        end++;
    splice(b, at, end - at, number, strlen(number));
}

static void mutate_line(bytes *b, unsigned long long *state, int copy)
{
    size_t at = random_below(state, b->size), end;
    bytes line = {NULL, 0, 0, 0};
    while (at > 0 && b->data[at - 1] != '\n')
        at--;
    end = at;
    while (end < b->size && b->data[end++] != '\n') {
    }
    put(&line, b->data + at, copy ? end - at : 0);
    splice(b, at, copy ? 0 : end - at, line.data, line.size);
    free(line.data);
}

static void mutate_swap(bytes *b, unsigned long long *state)
{
    size_t size = 1 + random_below(state, 16), a, c;
    unsigned char hold;
    if (b->size < 2 * size)
        return;
    a = random_below(state, b->size - size);
    c = random_below(state, b->size - size);
    for (size_t i = 0; i < size; i++) {
        hold = b->data[a + i];
        b->data[a + i] = b->data[c + i];
        b->data[c + i] = hold;
    }
}

static void mutate(bytes *b, unsigned long long *state)
{
    unsigned char byte = (unsigned char)random_below(state, 256);
    if (b->size == 0)
        return;
    switch (random_below(state, 8)) {
    case 0: b->data[random_below(state, b->size)] ^= (unsigned char)(1 << random_below(state, 8)); break;
    case 1: b->data[random_below(state, b->size)] = byte; break;
    case 2: b->size = random_below(state, b->size); break;
    case 3: mutate_line(b, state, 0); break;
    case 4: mutate_line(b, state, 1); break;
    case 5: mutate_swap(b, state); break;
    case 6: splice(b, random_below(state, b->size), 0, &byte, 1); break;
    default: mutate_number(b, state); break;
    }
}

/* What came out of a load must be usable: sound, or for surfaces at least within range, and it can be
 * written. */
static void use_mesh(const sb_mesh *mesh, int write)
{
    sb_error error;
    sb_result valid = sb_mesh_validate(mesh, &error);
    sb_real sum = 0;
    int volume = mesh->element_type >= SB_TET4;
    CHECK(valid == SB_OK || (!volume && valid == SB_ERROR_MESH));
    for (int e = 0; e < mesh->element_count; e++) {
        sum += sb_mesh_element_volume(mesh, e) + (sb_real)(mesh->regions ? mesh->regions[e] & 1 : 0);
        for (int k = 0; k < sb_element_node_count(mesh->element_type); k++)
            sum += mesh->nodes[mesh->elements[e * sb_element_node_count(mesh->element_type) + k]].x;
    }
    (void)sum;
    if (write) {
        sb_mesh loaded;
        const char *path = temporary("_m.vtk");
        CHECK_OK(write == 1 ? sb_mesh_save_vtk(path, mesh, NULL, 0, &error)
                            : sb_mesh_save_vtk_binary(path, mesh, NULL, 0, &error));
        if (CHECK_OK(sb_mesh_load(&loaded, path, NULL, &error))) {
            CHECK(same_nodes(mesh, &loaded) && same_elements(mesh, &loaded));
            sb_mesh_free(&loaded);
        }
        remove(path);
    }
}

static void test_mutations(void)
{
    enum { ROUNDS = 2500 };
    unsigned long long state = 20240601;
    int loads = 0, reads = 0;
    check_bad_numbers();
    for (int i = 0; i < SEED_COUNT * ROUNDS; i++) {
        bytes b = {NULL, 0, 0, 0};
        sb_mesh mesh, before;
        sb_error error;
        sb_result result;
        ration r;
        sb_load_options options = rationed(&r, -1);
        size_t rounds = 1 + random_below(&state, 3);
        seeds[i % SEED_COUNT].build(&b);
        for (size_t k = 0; k < rounds; k++)
            mutate(&b, &state);
        memset(&mesh, 0x5a, sizeof mesh);
        before = mesh;
        memset(&error, 0, sizeof error);
        options.fix_orientation = i / SEED_COUNT % 2;
        result = sb_mesh_load_memory(&mesh, b.data, b.size, i % 3 ? seeds[i % SEED_COUNT].format : SB_FILE_AUTO,
                                     "mutant", &options, &error);
        loads++;
        if (result == SB_OK) {
            use_mesh(&mesh, ++reads % 40 == 0 ? 1 + reads / 40 % 2 : 0);
            sb_mesh_free(&mesh);
        } else {
            CHECK(memcmp(&mesh, &before, sizeof mesh) == 0);
            CHECK(error.result == result && error.message[0] && strcmp(error.file, "mutant") == 0);
        }
        CHECK_INT(r.live, 0);
        CHECK(r.largest < 100 * (b.size + 100));
        bytes_free(&b);
    }
    CHECK(reads > loads / 50 && reads < loads);
}

CHECK_SUITE(meshio, {"every variant of every format", test_variants},
            {"byte order marks and NUL bytes", test_marks_and_nuls}, {"vtk number types", test_vtk_types},
            {"vtk cells", test_vtk_cells}, {"vtk regions", test_vtk_regions}, {"gmsh tet10 order", test_gmsh_tet10},
            {"gmsh hex20 and hex27 order", test_gmsh_hexes}, {"quadratic elements in texts", test_quadratic_texts},
            {"surface texts", test_surface_texts}, {"numbers are read exactly", test_numbers_exact},
            {"what is no number", test_numbers_refused}, {"locale", test_locale}, {"tetgen", test_tetgen},
            {"errors say where", test_errors}, {"arguments", test_arguments}, {"orientation", test_orientation},
            {"bad files", test_bad_files}, {"bad elements are named", test_bad_elements},
            {"good files", test_good_files}, {"one mesh in two formats", test_same_mesh},
            {"regions of the phantom", test_phantom_regions}, {"surfaces there and back", test_round_trip_surfaces},
            {"volumes there and back", test_round_trip_volumes},
            {"quadratic hexes there and back", test_round_trip_hexes}, {"fields", test_fields},
            {"writer errors", test_writer_errors}, {"failing memory", test_memory_failures},
            {"huge counts", test_huge_counts}, {"no slow files", test_no_slow_files}, {"mutations", test_mutations});
