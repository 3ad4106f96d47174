/* Fuzz target: a mesh file in memory, in every format, and the mesh that comes out is used.
 *
 * With libFuzzer: clang -fsanitize=fuzzer,address,undefined. Without: -DFUZZ_STANDALONE; then
 *     fuzz_meshio FILE...      runs the files
 *     fuzz_meshio -N [SEED]    runs N random mutations of the built-in files */
#define SB_IMPLEMENTATION
#include "softbody.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

/* What a loaded mesh promises; a violation is a finding. */
static void fuzz_require(int condition)
{
    if (!condition)
        abort();
}

static void fuzz_use(sb_mesh *mesh)
{
    sb_mesh_report report;
    sb_boundary boundary;
    sb_vec3 low, high;
    sb_real sum = 0;
    int nodes = sb_element_node_count(mesh->element_type), volume = mesh->element_type >= SB_TET4;
    sb_result valid = sb_mesh_validate(mesh, NULL);
    fuzz_require(valid == SB_OK || (!volume && valid == SB_ERROR_MESH));
    for (int i = 0; i < mesh->element_count; i++) {
        sum += sb_mesh_element_quality(mesh, i);
        for (int k = 0; k < nodes; k++)
            sum += mesh->nodes[mesh->elements[(size_t)i * (size_t)nodes + (size_t)k]].x;
        sum += (sb_real)(mesh->regions ? mesh->regions[i] & 1 : 0);
    }
    sb_mesh_bounds(mesh, &low, &high);
    fuzz_require(sb_v3_is_finite(low) && sb_v3_is_finite(high) && (sum <= 0 || sum > 0 || sum - sum != 0));
    if (sb_mesh_check(mesh, NULL, &report, NULL) == SB_OK)
        sb_mesh_report_free(&report);
    if (volume && sb_mesh_boundary(mesh, 1, NULL, &boundary, NULL) == SB_OK) {
        fuzz_require(sb_mesh_save_stl("/dev/null", &boundary.surface, NULL) != SB_ERROR_INDEX);
        sb_boundary_free(&boundary);
    }
    fuzz_require(sb_mesh_save_vtk("/dev/null", mesh, NULL, 0, NULL) == SB_OK);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    /* OBJ and truncated STL have no mark in the file that would tell them */
    static const sb_file_format formats[3] = {SB_FILE_AUTO, SB_FILE_OBJ, SB_FILE_STL};
    for (int i = 0; i < 3; i++) {
        sb_mesh mesh;
        sb_error error;
        sb_load_report report;
        sb_load_options options = sb_default_load_options();
        options.fix_orientation = (int)(size & 1);
        options.report = &report;
        memset(&mesh, 0, sizeof mesh);
        if (sb_mesh_load_memory(&mesh, data, size, formats[i], "fuzz", &options, &error) != SB_OK) {
            fuzz_require(mesh.nodes == NULL && mesh.elements == NULL && error.result != SB_OK &&
                         error.message[0]);
            continue;
        }
        fuzz_require(report.unreferenced_nodes >= 0 && report.unreferenced_nodes <= mesh.node_count);
        fuzz_use(&mesh);
        sb_mesh_free(&mesh);
        break;
    }
    return 0;
}

/* Bytes with zeros inside: text and its length. */
#define FUZZ_SEED(text)                                                                                      \
    {                                                                                                        \
        text, sizeof text - 1                                                                                \
    }
#define FUZZ_ONE "\x3f\x80\x00\x00"
#define FUZZ_ZERO "\x00\x00\x00\x00"
#define FUZZ_STL_ONE "\x00\x00\x80\x3f"

static const struct fuzz_seed {
    const char *data;
    size_t size;
} fuzz_seeds[] = {
    FUZZ_SEED(
        "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 float\n0 0 0 1 0 0 0 1 0\n"
        "0 0 1 1 1 1\nCELLS 3 14\n4 0 1 2 3\n4 1 2 3 4\n3 0 1 2\nCELL_TYPES 3\n10 10 5\nCELL_DATA 3\n"
        "SCALARS region int 1\nLOOKUP_TABLE default\n1 2 3\nVECTORS v float\n1 2 3 4 5 6 7 8 9\n"),
    FUZZ_SEED(
        "# vtk DataFile Version 5.1\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 8 double\n0 0 0 1 0 0 1 1 "
        "0\n"
        "0 1 0 0 0 1 1 0 1 1 1 1 0 1 1\nCELLS 2 8\nOFFSETS vtktypeint64\n0 8\nCONNECTIVITY vtktypeint64\n"
        "0 1 2 3 4 5 6 7\nCELL_TYPES 1\n12\nCELL_DATA 1\nFIELD f 1\nregion 1 1 int\n4\nMETADATA\nx\n\n"),
    FUZZ_SEED("# vtk DataFile Version 3.0\nt\nBINARY\nDATASET POLYDATA\nPOINTS 3 float\n" FUZZ_ZERO FUZZ_ZERO
                  FUZZ_ZERO FUZZ_ONE FUZZ_ZERO FUZZ_ZERO FUZZ_ZERO FUZZ_ONE FUZZ_ZERO
              "\nPOLYGONS 1 4\n\x00\x00\x00\x03" FUZZ_ZERO "\x00\x00\x00\x01\x00\x00\x00\x02\n"),
    FUZZ_SEED(
        "# vtk DataFile Version 3.0\nt\nASCII\nDATASET POLYDATA\nPOINTS 4 int\n0 0 0 1 0 0 0 1 0 1 1 0\n"
        "VERTICES 1 2\n1 0\nLINES 1 3\n2 0 1\nPOLYGONS 1 5\n4 0 1 3 2\nTRIANGLE_STRIPS 1 5\n4 0 1 2 3\n"
        "POINT_DATA 4\nCOLOR_SCALARS c 1\n0 0 1 1\n"),
    FUZZ_SEED(
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n1\n3 1 \"a\"\n$EndPhysicalNames\n$Nodes\n4\n"
        "1 0 0 0\n5 1 0 0\n3 0 1 0\n9 0 0 1\n$EndNodes\n$Elements\n2\n1 2 2 0 1 1 5 3\n2 4 2 7 1 1 5 3 9\n"
        "$EndElements\n"),
    FUZZ_SEED(
        "$MeshFormat\n2.2 1 8\n\x01\x00\x00\x00\n$EndMeshFormat\n$Nodes\n3\n"
        "\x01\x00\x00\x00" FUZZ_ZERO FUZZ_ZERO FUZZ_ZERO FUZZ_ZERO FUZZ_ZERO FUZZ_ZERO
        "\x02\x00\x00\x00" FUZZ_ZERO "\x00\x00\xf0\x3f" FUZZ_ZERO FUZZ_ZERO FUZZ_ZERO FUZZ_ZERO
        "\x03\x00\x00\x00" FUZZ_ZERO FUZZ_ZERO FUZZ_ZERO "\x00\x00\xf0\x3f" FUZZ_ZERO FUZZ_ZERO
        "\n$EndNodes\n$"
        "Elements\n1\n\x02\x00\x00\x00\x01\x00\x00\x00\x02\x00\x00\x00\x01\x00\x00\x00" FUZZ_ZERO FUZZ_ZERO
        "\x01\x00\x00\x00\x02\x00\x00\x00\x03\x00\x00\x00\n$EndElements\n"),
    FUZZ_SEED(
        "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Entities\n0 0 0 1\n1 0 0 0 1 1 1 2 7 8 "
        "0\n$EndEntities\n$Nodes\n"
        "2 10 1 10\n3 1 0 4\n1\n2\n3\n4\n0 0 0\n2 0 0\n0 2 0\n0 0 2\n3 1 1 6\n5\n6\n7\n8\n9\n10\n1 0 0 0 0 "
        "0\n"
        "1 1 0 0 0 0\n0 1 0 0 0 0\n0 0 1 0 0 0\n0 1 1 0 0 0\n1 0 1 0 0 0\n$EndNodes\n$Elements\n1 1 1 1\n"
        "3 1 11 1\n1 1 2 3 4 5 6 7 8 9 10\n$EndElements\n"),
    FUZZ_SEED("# o\r\nv 0 0 0\r\nv 1 0 0\r\nv 1 1 0 1\r\nv 0 1 \\\r\n0\r\nvn 0 0 1\r\nvt 0 0\r\nf 1/1/1 2//1 "
              "3/1 -1\r\n"),
    FUZZ_SEED("solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 "
              "0\nendloop\nendfacet\n"
              "endsolid a\n"),
    FUZZ_SEED("binary                                                                          "
              "\x01\x00\x00\x00" FUZZ_ZERO FUZZ_ZERO FUZZ_STL_ONE FUZZ_ZERO FUZZ_ZERO FUZZ_ZERO FUZZ_STL_ONE
                  FUZZ_ZERO FUZZ_ZERO FUZZ_ZERO FUZZ_STL_ONE FUZZ_ZERO "\x00\x00"),
    FUZZ_SEED("ply\nformat ascii 1.0\ncomment c\nelement vertex 3\nproperty float x\nproperty float "
              "y\nproperty float z\n"
              "property uchar red\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0 "
              "1\n1 0 0 2\n"
              "0 1 0 3\n3 0 1 2\n"),
    FUZZ_SEED("ply\nformat binary_big_endian 1.0\nelement vertex 3\nproperty float x\nproperty float "
              "y\nproperty short z\n"
              "element face 1\nproperty list uchar int vertex_index\nend_header\n" FUZZ_ZERO FUZZ_ZERO
              "\x00\x00" FUZZ_ONE FUZZ_ZERO "\x00\x00" FUZZ_ZERO FUZZ_ONE "\x00\x00\x03" FUZZ_ZERO
              "\x00\x00\x00\x01\x00\x00\x00\x02"),
    FUZZ_SEED("COFF\n4 2 0\n0 0 0 1 1 1 1\n1 0 0 1 1 1 1\n1 1 0 1 1 1 1\n0 1 0 1 1 1 1\n4 0 1 2 3\n2 0 1 # "
              "edge\n")};
enum { FUZZ_SEEDS = sizeof fuzz_seeds / sizeof fuzz_seeds[0] };

#if !defined(FUZZ_STANDALONE)

size_t LLVMFuzzerMutate(uint8_t *data, size_t size, size_t max_size);
size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned int seed);

/* Starts from the built-in files where there is no corpus: a format's first line is hard to come by. */
size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned int seed)
{
    const struct fuzz_seed *file = &fuzz_seeds[seed % FUZZ_SEEDS];
    if ((size < 8 || seed % 1000 == 0) && file->size <= max_size) {
        memcpy(data, file->data, file->size);
        return file->size;
    }
    return LLVMFuzzerMutate(data, size, max_size);
}

#else

static uint64_t fuzz_random(uint64_t *state)
{
    uint64_t x = *state;
    x ^= x >> 12;
    x ^= x << 25;
    x ^= x >> 27;
    *state = x;
    return (x * 2685821657736338717u) >> 16;
}

/* One change in place; returns the new size. */
static size_t fuzz_mutate(uint8_t *data, size_t size, uint64_t *state)
{
    static const char numbers[12][21] = {"-1",         "0",  "7",   "4000000000",           "nan",  "1e999",
                                         "2147483647", "-5", "3.5", "18446744073709551616", "1e-9", "x"};
    size_t at = size ? (size_t)(fuzz_random(state) % size) : 0, length;
    if (size == 0)
        return 0;
    switch (fuzz_random(state) % 7) {
    case 0: data[at] ^= (uint8_t)(1u << fuzz_random(state) % 8); break;
    case 1: data[at] = (uint8_t)fuzz_random(state); break;
    case 2: return at;
    case 3: /* a number of the list over what stands there */
        length = strlen(numbers[fuzz_random(state) % 12]);
        memcpy(data + at, numbers[fuzz_random(state) % 12], length < size - at ? length : size - at);
        break;
    case 4: /* cut a piece out */
        length = (size_t)(fuzz_random(state) % 20);
        if (length > size - at)
            length = size - at;
        memmove(data + at, data + at + length, size - at - length);
        return size - length;
    case 5: /* write one place over another */
        length = (size_t)(fuzz_random(state) % 20);
        if (at + length < size)
            memmove(data + fuzz_random(state) % (size - length), data + at, length);
        break;
    default: data[at] = data[fuzz_random(state) % size]; break;
    }
    return size;
}

static void fuzz_run_mutations(long count, uint64_t state)
{
    uint8_t data[2048];
    for (long i = 0; i < count; i++) {
        const struct fuzz_seed *seed = &fuzz_seeds[i % FUZZ_SEEDS];
        size_t size = seed->size;
        uint8_t *exact; /* of its own size, so that a reader past the end is seen */
        memcpy(data, seed->data, size);
        for (uint64_t k = 0, changes = i < FUZZ_SEEDS ? 0 : 1 + fuzz_random(&state) % 4; k < changes; k++)
            size = fuzz_mutate(data, size, &state);
        exact = (uint8_t *)malloc(size ? size : 1);
        if (!exact)
            return;
        memcpy(exact, data, size);
        LLVMFuzzerTestOneInput(exact, size);
        free(exact);
    }
}

static int fuzz_run_file(const char *path)
{
    FILE *file = fopen(path, "rb");
    uint8_t *data = NULL;
    size_t size = 0;
    if (!file)
        return 1;
    for (size_t got = 1; got;) {
        uint8_t *grown = (uint8_t *)realloc(data, size + 65536);
        if (!grown)
            break;
        data = grown;
        got = fread(data + size, 1, 65536, file);
        size += got;
    }
    fclose(file);
    LLVMFuzzerTestOneInput(data, size);
    free(data);
    return 0;
}

int main(int argc, char **argv)
{
    int failed = 0;
    if (argc > 1 && argv[1][0] == '-')
        fuzz_run_mutations(strtol(argv[1] + 1, NULL, 10), argc > 2 ? strtoull(argv[2], NULL, 10) | 1 : 1);
    for (int i = 1; i < argc && argv[1][0] != '-'; i++)
        failed |= fuzz_run_file(argv[i]);
    printf("fuzz_meshio: done\n");
    return failed;
}
#endif
