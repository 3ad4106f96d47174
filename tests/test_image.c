/* Label images: files written by VTK and by hand, malformed ones, and where points find their voxels. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

#include <limits.h>

/* All files of the folder hold this image. */
static int expected_label(int i, int j, int k) { return (i + 2 * j + 5 * k) % 4; }

static void check_content(const sb_image *image)
{
    CHECK_INT(image->counts[0], 4);
    CHECK_INT(image->counts[1], 3);
    CHECK_INT(image->counts[2], 2);
    for (int k = 0; k < 2; k++)
        for (int j = 0; j < 3; j++)
            for (int i = 0; i < 4; i++)
                CHECK_INT(image->labels[(k * 3 + j) * 4 + i], expected_label(i, j, k));
}

static void check_vector(sb_vec3 v, double x, double y, double z)
{
    CHECK_NEAR(v.x, x, 1e-6);
    CHECK_NEAR(v.y, y, 1e-6);
    CHECK_NEAR(v.z, z, 1e-6);
}

/* Loads a file of the corpus, in millimetres. */
static int load(const char *name, sb_image *image)
{
    sb_load_options options = sb_default_load_options();
    char path[256];
    sb_error error;
    snprintf(path, sizeof path, "tests/fuzz/corpus/image/%s", name);
    options.scale = (sb_real)0.001;
    error.message[0] = 0;
    CHECK(sb_image_is_file(path));
    if (!CHECK_OK(sb_image_load(image, path, &options, &error))) {
        printf("%s: %s\n", name, error.message);
        return 0;
    }
    return 1;
}

static void test_files(void)
{
    static const char *const names[] = {
        "points_char_ascii.vtk",  "points_char_binary.vtk",    "points_uchar_ascii.vtk",  "points_uchar_binary.vtk",
        "points_short_ascii.vtk", "points_short_binary.vtk",   "points_ushort_ascii.vtk", "points_ushort_binary.vtk",
        "points_int_ascii.vtk",   "points_int_binary.vtk",     "points_uint_ascii.vtk",   "points_uint_binary.vtk",
        "points_float_ascii.vtk", "points_float_binary.vtk",   "points_double_ascii.vtk", "points_double_binary.vtk",
        "points_ascii.vti",       "points_base64.vti",         "points_base64_zlib.vti",  "points_raw.vti",
        "points_raw_zlib.vti",    "points_appended64_big.vti", "points_zlib.mha",         "points_raw.mha",
        "points_raw.mhd",         "points_raw_big.nrrd",       "points_gzip.nrrd",        "points_text.nrrd",
        "points_uchar.nii",       "points_short_big.nii.gz",   "points_float_2.nii.gz",   "points_scaled.nii"};
    for (size_t n = 0; n < sizeof names / sizeof names[0]; n++) {
        sb_image image;
        if (!load(names[n], &image))
            continue;
        check_content(&image);
        check_vector(sb_v3_scale(1000, image.origin), 1, -2, 3);
        check_vector(sb_v3_scale(1000, image.spacing), 0.5, 0.25, 2);
        for (int axis = 0; axis < 3; axis++)
            check_vector(sb_m3_column(image.direction, axis), axis == 0, axis == 1, axis == 2);
        sb_image_free(&image);
        CHECK(image.labels == NULL && image.counts[0] == 0);
    }
}

/* Values of cells lie half a spacing from the points. */
static void test_cells(void)
{
    static const char *const names[] = {"cells_uchar_binary.vtk", "cells_raw_zlib.vti"};
    for (int n = 0; n < 2; n++) {
        sb_image image;
        if (!load(names[n], &image))
            continue;
        check_content(&image);
        check_vector(sb_v3_scale(1000, image.origin), 1.25, -1.875, 4);
        sb_image_free(&image);
    }
}

/* i points along y, j along -x, and the extent begins at (2, 0, -1). */
static void test_turned(void)
{
    sb_image image;
    if (!load("turned_ascii.vti", &image))
        return;
    check_content(&image);
    check_vector(sb_m3_column(image.direction, 0), 0, 1, 0);
    check_vector(sb_m3_column(image.direction, 1), -1, 0, 0);
    check_vector(sb_v3_scale(1000, image.origin), 1, -1, 1);
    CHECK_INT(sb_image_label_at(&image, sb_v3((sb_real)0.001 - (sb_real)0.0005, (sb_real)-0.0005, (sb_real)0.0035)),
              expected_label(1, 2, 1));
    sb_image_free(&image);
}

/* Rows of MetaImage's matrix are the axes; NRRD's vectors carry the spacing. */
static void test_directions(void)
{
    static const char meta[] =
        "ObjectType = Image\nNDims = 3\nBinaryData = False\nTransformMatrix = 0 1 0 -1 0 0 0 0 1\n"
        "Offset = 1 2 3\nElementSpacing = 2 3 4\nDimSize = 2 1 1\nElementType = MET_INT\n"
        "ElementDataFile = LOCAL\n7 -8\n";
    static const char nrrd[] = "NRRD0004\ntype: int\ndimension: 3\nsizes: 2 1 1\nencoding: ascii\n"
                               "space directions: (0,2,0) (-3,0,0) (0,0,4)\nspace origin: (1,2,3)\n\n7 -8\n";
    for (int n = 0; n < 2; n++) {
        sb_image image;
        sb_error error;
        int label = 0;
        if (!CHECK_OK(sb_image_load_memory(&image, n ? nrrd : meta, strlen(n ? nrrd : meta), "x", NULL, &error))) {
            printf("%s\n", error.message);
            continue;
        }
        check_vector(image.origin, 1, 2, 3);
        check_vector(image.spacing, 2, 3, 4);
        check_vector(sb_m3_column(image.direction, 0), 0, 1, 0);
        check_vector(sb_m3_column(image.direction, 1), -1, 0, 0);
        CHECK_INT(sb_image_label_at(&image, sb_v3(1, 4, 3)), -8);
        CHECK_INT(sb_image_label_at(&image, sb_v3(1, (sb_real)5.1, 3)), 0);
        CHECK(sb_image_next_label(&image, INT_MIN, &label) && label == -8);
        CHECK(sb_image_next_label(&image, label, &label) && label == 7);
        CHECK(!sb_image_next_label(&image, label, &label) && label == 7);
        sb_image_free(&image);
    }
}

/* A left-handed image, by the turn and by the matrix of NIfTI's header. */
static void test_nifti_turned(void)
{
    static const char *const names[] = {"turned_q.nii", "turned_s.nii"};
    for (int n = 0; n < 2; n++) {
        sb_image image;
        if (!load(names[n], &image))
            continue;
        check_content(&image);
        check_vector(sb_v3_scale(1000, image.origin), 1, 2, 3);
        check_vector(sb_v3_scale(1000, image.spacing), 2, 3, 4);
        check_vector(sb_m3_column(image.direction, 0), 0, 1, 0);
        check_vector(sb_m3_column(image.direction, 1), -cos(0.3), 0, sin(0.3));
        check_vector(sb_m3_column(image.direction, 2), -sin(0.3), 0, -cos(0.3));
        sb_image_free(&image);
    }
}

/* ---- malformed ---- */

#define POINTS "# vtk DataFile Version 3.0\nx\nASCII\nDATASET STRUCTURED_POINTS\n"
#define LABELS "POINT_DATA 2\nSCALARS a int 1\nLOOKUP_TABLE default\n"
#define META "ObjectType = Image\nNDims = 3\n"
#define NRRD "NRRD0004\ndimension: 3\nsizes: 2 1 1\n"
#define VTI(attributes, piece, content)                                                                                \
    "<VTKFile type=\"ImageData\" byte_order=\"LittleEndian\">\n<ImageData " attributes ">\n<Piece Extent=\"" piece     \
    "\">\n"                                                                                                            \
    "<PointData><DataArray type=\"Int32\" Name=\"a\" format=\"ascii\">" content                                        \
    "</DataArray></PointData></Piece></ImageData></VTKFile>"

static void test_malformed(void)
{
    static const struct {
        const char *text;
        sb_result result;
        int line;
        const char *message;
    } cases[] = {
        {"", SB_ERROR_FORMAT, 1, "the file is empty"},
        {"hello", SB_ERROR_FORMAT, 1, "no image of VTK's"},
        {POINTS "DIMENSIONS 2 1 1\nSPACING 1 nan 1\n", SB_ERROR_NOT_FINITE, 6, "spacing"},
        {POINTS "DIMENSIONS 2 1 1\nSPACING 1 1e999 1\n", SB_ERROR_NOT_FINITE, 6, "spacing"},
        {POINTS "DIMENSIONS 2 1 1\nSPACING 1 0 1\n", SB_ERROR_FORMAT, 6, "a spacing of 0"},
        {POINTS "DIMENSIONS 2 1 1\nSPACING 1 -1 1\n", SB_ERROR_FORMAT, 6, "a spacing of -1"},
        {POINTS "DIMENSIONS 2 1 1\nORIGIN 1 inf 1\n", SB_ERROR_NOT_FINITE, 6, "origin"},
        {POINTS "DIMENSIONS 2 0 1\n", SB_ERROR_FORMAT, 5, "a dimension is 0"},
        {POINTS "DIMENSIONS 2000000 2000000 2000000\n", SB_ERROR_UNSUPPORTED, 5, "more than 2147483647 voxels"},
        {POINTS "DIMENSIONS 1000 1000 1000\nPOINT_DATA 1000000000\nSCALARS a int 1\nLOOKUP_TABLE default\n1 2 3\n",
         SB_ERROR_FORMAT, 9, "too short"},
        {POINTS LABELS "1 2\n", SB_ERROR_FORMAT, 5, "data before DIMENSIONS"},
        {POINTS "DIMENSIONS 3 1 1\n" LABELS "1 2\n", SB_ERROR_FORMAT, 6, "data of 2 points, but there are 3"},
        {POINTS "DIMENSIONS 2 1 1\n" LABELS "1\n", SB_ERROR_FORMAT, 0, "too short"},
        {POINTS "DIMENSIONS 2 1 1\n" LABELS "1 2 3\n", SB_ERROR_FORMAT, 9, "'3' where a section should begin"},
        {POINTS "DIMENSIONS 2 1 1\n" LABELS "1 2.5\n", SB_ERROR_FORMAT, 9, "voxel 1 is 2.5: labels are whole numbers"},
        {POINTS "DIMENSIONS 2 1 1\n" LABELS "1 3e9\n", SB_ERROR_FORMAT, 9, "voxel 1 is 3e+09"},
        {POINTS "DIMENSIONS 2 1 1\n" LABELS "1 nan\n", SB_ERROR_NOT_FINITE, 9, "is not finite"},
        {POINTS "DIMENSIONS 2 1 1\n", SB_ERROR_FORMAT, 6, "no array of one number per point"},
        {POINTS "DIMENSIONS 2 1 1\nPOINT_DATA 2\nVECTORS v float\n0 0 0 0 0 0\n", SB_ERROR_FORMAT, 9,
         "no array of one number"},
        {POINTS "DIMENSIONS 2 1 1\nDIMENSIONS 2 1 1\n", SB_ERROR_FORMAT, 6, "a second DIMENSIONS"},
        {POINTS "DIMENSIONS 2 1 1\nPOINTS 2 float\n", SB_ERROR_FORMAT, 6, "'POINTS' where a section"},
        {"# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\n", SB_ERROR_UNSUPPORTED, 4, "sb_mesh_load"},
        {"<VTKFile type=\"PolyData\">", SB_ERROR_UNSUPPORTED, 1, "sb_mesh_load"},
        {VTI("WholeExtent=\"0 1 0 0 0 0\"", "0 1 0 0 0 0", "1"), SB_ERROR_FORMAT, 4, "too short"},
        {VTI("WholeExtent=\"0 1 0 0 0 0\"", "0 1 0 0 0 0", "1 2 3"), SB_ERROR_FORMAT, 4, "more values than the voxels"},
        {VTI("WholeExtent=\"0 1 0 0 0 0\"", "0 0 0 0 0 0", "1"), SB_ERROR_UNSUPPORTED, 3, "several pieces"},
        {VTI("WholeExtent=\"0 1 0 0 0\"", "0 1 0 0 0 0", "1 2"), SB_ERROR_FORMAT, 2, "WholeExtent"},
        {VTI("WholeExtent=\"0 1 0 0 0 0 0\"", "0 1 0 0 0 0", "1 2"), SB_ERROR_FORMAT, 2, "more than 6 numbers"},
        {VTI("WholeExtent=\"0 1 0 0 0 -1\"", "0 1 0 0 0 -1", "1 2"), SB_ERROR_FORMAT, 2, "missing or empty"},
        {VTI("Origin=\"0 0 0\"", "0 1 0 0 0 0", "1 2"), SB_ERROR_FORMAT, 2, "missing or empty"},
        {VTI("WholeExtent=\"0 1 0 0 0 0\" Spacing=\"1 1 -1\"", "0 1 0 0 0 0", "1 2"), SB_ERROR_FORMAT, 2,
         "a spacing of -1"},
        {VTI("WholeExtent=\"0 1 0 0 0 0\" Direction=\"1 0 0 1 0 0 0 0 1\"", "0 1 0 0 0 0", "1 2"), SB_ERROR_NOT_FINITE,
         0, "a direction of length 0"},
        {VTI("WholeExtent=\"0 1 0 0 0 0\" Direction=\"1 1 0 0 0 0 0 0 1\"", "0 1 0 0 0 0", "1 2"), SB_ERROR_FORMAT, 0,
         "the axes lie in a plane"},
        {META "DimSize = 2 1 1\nElementType = MET_UCHAR\nElementDataFile = LOCAL\nx", SB_ERROR_FORMAT, 0,
         "1 bytes are there"},
        {META "DimSize = 2 1 1\nElementType = MET_UCHAR\nElementDataFile = LOCAL\nxyz", SB_ERROR_FORMAT, 0,
         "1 bytes follow the 2 voxels"},
        {META "DimSize = 2 1 1\nElementType = MET_UCHAR\n", SB_ERROR_FORMAT, 5, "without ElementDataFile"},
        {META "DimSize = 2 1 1\nElementDataFile = LOCAL\nxy", SB_ERROR_FORMAT, 4, "no ElementType"},
        {META "ElementType = MET_UCHAR\nElementDataFile = LOCAL\nxy", SB_ERROR_FORMAT, 4, "no DimSize"},
        {META "ElementType = MET_STRING\n", SB_ERROR_UNSUPPORTED, 3, "MET_STRING"},
        {META "DimSize = 2 x 1\n", SB_ERROR_FORMAT, 3, "'x' is not an integer"},
        {META "DimSize = 2 1\n", SB_ERROR_FORMAT, 3, "the file ends where"},
        {META "DimSize = 99999 99999 99999\nElementType = MET_UCHAR\nElementDataFile = LOCAL\nxy", SB_ERROR_UNSUPPORTED,
         6, "more than 2147483647 voxels"},
        {META "ElementSpacing = 1 0 1\n", SB_ERROR_FORMAT, 3, "a spacing of 0"},
        {META "ElementNumberOfChannels = 3\n", SB_ERROR_UNSUPPORTED, 3, "3 values per voxel"},
        {META "no sign\n", SB_ERROR_FORMAT, 3, "without \"=\""},
        {"NDims = 4\n", SB_ERROR_UNSUPPORTED, 1, "4 dimensions"},
        {META "CompressedData = True\nDimSize = 2 1 1\nElementType = MET_UCHAR\nElementDataFile = LOCAL\nxyzxyzxyz",
         SB_ERROR_FORMAT, 0, "no zlib header"},
        {META "DimSize = 2 1 1\nElementType = MET_UCHAR\nElementDataFile = a.raw\n", SB_ERROR_UNSUPPORTED, 0, "a.raw"},
        {META "DimSize = 2 1 1\nElementType = MET_UCHAR\nElementDataFile = LIST\n", SB_ERROR_UNSUPPORTED, 5,
         "several files"},
        {NRRD "type: uchar\n\nxy", SB_ERROR_FORMAT, 6, "no encoding"},
        {NRRD "encoding: raw\n\nxy", SB_ERROR_FORMAT, 6, "no type"},
        {NRRD "type: short\nencoding: raw\n\nxyzw", SB_ERROR_FORMAT, 7, "no endian"},
        {NRRD "type: uchar\nencoding: bzip2\n\nxy", SB_ERROR_UNSUPPORTED, 5, "bzip2"},
        {NRRD "type: uchar\nencoding: gzip\n\nxyzxyzxyzxyzxyzxyzxyz", SB_ERROR_FORMAT, 0, "no gzip header"},
        {NRRD "type: uchar\nencoding: raw\n\nx", SB_ERROR_FORMAT, 0, "1 bytes are there"},
        {NRRD "type: uchar\nencoding: raw\n", SB_ERROR_FORMAT, 6, "ends in its header"},
        {NRRD "space directions: (1,0,0) (0,1,0) (0,0)\n", SB_ERROR_UNSUPPORTED, 4, "a vector of 2 numbers"},
        {NRRD "space directions: none (1,0,0) (0,1,0)\n", SB_ERROR_UNSUPPORTED, 4, "is missing"},
        {NRRD "space origin: (1,nan,0)\n", SB_ERROR_NOT_FINITE, 4, "not finite"},
        {NRRD "no sign\n", SB_ERROR_FORMAT, 4, "without \":\""},
        {"NRRD0004\nsizes: 2 1 1\n", SB_ERROR_FORMAT, 2, "dimension must come before"},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        sb_image image;
        sb_error error;
        int told;
        memset(&image, 7, sizeof image);
        error.message[0] = 0;
        told = CHECK_RESULT(sb_image_load_memory(&image, cases[i].text, strlen(cases[i].text), "bad", NULL, &error),
                            cases[i].result);
        told = CHECK(strstr(error.message, cases[i].message) != NULL) && told;
        told = CHECK(cases[i].line == 0 || error.line == cases[i].line) && told;
        CHECK(strcmp(error.file, "bad") == 0 && image.counts[0] == 0x07070707);
        if (!told)
            printf("case %d: %s:%d: %s\n", (int)i, error.file, error.line, error.message);
    }
}

enum { NIFTI_BYTES = 376, NIFTI_DIM = 40, NIFTI_TYPE = 70, NIFTI_SPACING = 76, NIFTI_OFFSET = 108, NIFTI_ROWS = 280 };

static void put_short(unsigned char *at, int value)
{
    at[0] = (unsigned char)(value & 255);
    at[1] = (unsigned char)(value >> 8 & 255);
}

static void put_float(unsigned char *at, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    put_short(at, (int)(bits & 65535));
    put_short(at + 2, (int)(bits >> 16));
}

static size_t read_file(const char *name, unsigned char *data, size_t capacity)
{
    char path[256];
    size_t size;
    FILE *file;
    snprintf(path, sizeof path, "tests/fuzz/corpus/image/%s", name);
    file = fopen(path, "rb");
    if (!CHECK(file != NULL))
        return 0;
    size = fread(data, 1, capacity, file);
    fclose(file);
    return size;
}

/* One field of a good header is wrong. */
static void test_nifti_malformed(void)
{
    static const struct {
        int at, is_float;
        double value;
        sb_result result;
        const char *message;
    } cases[] = {{NIFTI_DIM, 0, 0, SB_ERROR_FORMAT, "of 0 dimensions"},
                 {NIFTI_DIM, 0, 8, SB_ERROR_FORMAT, "of 8 dimensions"},
                 {NIFTI_DIM, 0, -1, SB_ERROR_FORMAT, "of -1 dimensions"},
                 {NIFTI_DIM + 2, 0, 0, SB_ERROR_FORMAT, "0 voxels along axis 0"},
                 {NIFTI_DIM + 6, 0, -2, SB_ERROR_FORMAT, "-2 voxels along axis 2"},
                 {NIFTI_DIM + 2, 0, 5, SB_ERROR_FORMAT, "30 voxels of 1 bytes are announced, but 24 bytes"},
                 {NIFTI_DIM + 2, 0, 3, SB_ERROR_FORMAT, "6 bytes follow the 18 voxels"},
                 {NIFTI_TYPE, 0, 128, SB_ERROR_UNSUPPORTED, "data type 128"},
                 {NIFTI_TYPE, 0, 1, SB_ERROR_UNSUPPORTED, "data type 1"},
                 {NIFTI_OFFSET, 1, 300, SB_ERROR_FORMAT, "begin at byte 300"},
                 {NIFTI_OFFSET, 1, 352.5, SB_ERROR_FORMAT, "begin at byte 352.5"},
                 {NIFTI_OFFSET, 1, 1e30, SB_ERROR_FORMAT, "begin at byte 1e+30"},
                 {NIFTI_OFFSET, 1, 4000, SB_ERROR_FORMAT, "but 0 bytes are there"},
                 {NIFTI_ROWS, 1, 0, SB_ERROR_NOT_FINITE, "a direction of length 0"},
                 {344, 0, 'x' + 256 * '+', SB_ERROR_FORMAT, "no image of VTK's"},
                 {345, 0, 'i' + 256 * '1', SB_ERROR_UNSUPPORTED, "in another file"}};
    unsigned char good[NIFTI_BYTES + 1];
    sb_image image;
    sb_error error;
    if (!CHECK_INT(read_file("points_uchar.nii", good, sizeof good), NIFTI_BYTES))
        return;
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        unsigned char data[NIFTI_BYTES];
        int told;
        memcpy(data, good, NIFTI_BYTES);
        if (cases[i].is_float)
            put_float(data + cases[i].at, (float)cases[i].value);
        else
            put_short(data + cases[i].at, (int)cases[i].value);
        memset(&image, 7, sizeof image);
        error.message[0] = 0;
        told = CHECK_RESULT(sb_image_load_memory(&image, data, NIFTI_BYTES, "bad", NULL, &error), cases[i].result);
        told = CHECK(strstr(error.message, cases[i].message) != NULL) && told;
        CHECK(image.counts[0] == 0x07070707);
        if (!told)
            printf("case %d: %s\n", (int)i, error.message);
    }
    memset(good + NIFTI_ROWS, 0xFF, 4); /* not a number, whatever the byte order */
    CHECK_RESULT(sb_image_load_memory(&image, good, NIFTI_BYTES, "bad", NULL, &error), SB_ERROR_NOT_FINITE);
}

/* Axes that are not used: a fourth of one volume is fine, of two is not; images of a layer have two. */
static void test_nifti_axes(void)
{
    unsigned char data[NIFTI_BYTES + 1];
    sb_image image;
    sb_error error;
    if (!CHECK_INT(read_file("points_uchar.nii", data, sizeof data), NIFTI_BYTES))
        return;
    put_short(data + NIFTI_DIM, 4);
    if (CHECK_OK(sb_image_load_memory(&image, data, NIFTI_BYTES, "x", NULL, &error))) {
        check_content(&image);
        sb_image_free(&image);
    }
    put_short(data + NIFTI_DIM + 8, 2);
    CHECK_RESULT(sb_image_load_memory(&image, data, NIFTI_BYTES, "x", NULL, &error), SB_ERROR_UNSUPPORTED);
    CHECK(strstr(error.message, "2 values per voxel") != NULL);
    put_short(data + NIFTI_DIM, 2);
    if (CHECK_OK(sb_image_load_memory(&image, data, NIFTI_BYTES - 12, "x", NULL, &error))) {
        CHECK(image.counts[0] == 4 && image.counts[1] == 3 && image.counts[2] == 1);
        sb_image_free(&image);
    }
}

/* A file that is packed but holds no image, and one whose packed voxels would unpack to more than it announces. */
static void test_nifti_packed(void)
{
    unsigned char data[512], other[64] = {0x1F, 0x8B, 8, 0, 0, 0, 0, 0, 0, 3, 1, 0, 0, 0xFF, 0xFF, 0, 0, 0, 0};
    size_t size = read_file("points_short_big.nii.gz", data, sizeof data);
    sb_image image;
    sb_error error;
    CHECK_RESULT(sb_image_load_memory(&image, other, sizeof other, "x", NULL, &error), SB_ERROR_UNSUPPORTED);
    CHECK(strstr(error.message, "unpack it first") != NULL);
    for (size_t at = 0; at < size; at++) { /* whatever byte is damaged: no crash, and nothing but what was packed */
        unsigned char byte = data[at];
        data[at] = (unsigned char)(byte ^ 0x55);
        if (sb_image_load_memory(&image, data, size, "x", NULL, &error) == SB_OK) {
            check_content(&image);
            sb_image_free(&image);
        }
        data[at] = byte;
    }
}

/* Every file cut off anywhere is an error, or, where only blanks or end tags are missing, the same image. */
static void test_truncated(void)
{
    static const char *const names[] = {"points_short_ascii.vtk", "points_short_binary.vtk", "points_base64_zlib.vti",
                                        "points_raw_zlib.vti",    "points_zlib.mha",         "points_gzip.nrrd",
                                        "points_raw_big.nrrd",    "points_scaled.nii",       "points_float_2.nii.gz"};
    for (size_t n = 0; n < sizeof names / sizeof names[0]; n++) {
        char path[256], data[8192];
        size_t size;
        int failed = 0;
        FILE *file;
        snprintf(path, sizeof path, "tests/fuzz/corpus/image/%s", names[n]);
        file = fopen(path, "rb");
        if (!CHECK(file != NULL))
            return;
        size = fread(data, 1, sizeof data, file);
        fclose(file);
        for (size_t cut = 0; cut < size; cut++) {
            sb_image image;
            sb_error error;
            if (sb_image_load_memory(&image, data, cut, "cut", NULL, &error) != SB_OK) {
                CHECK(error.message[0] && error.result != SB_ERROR_MEMORY);
                failed++;
                continue;
            }
            check_content(&image);
            sb_image_free(&image);
        }
        CHECK(failed > (int)size / 2);
    }
}

/* A header must not make us read what is not beside it. */
static void test_detached(void)
{
    static const char *const elsewhere[] = {"/etc/passwd", "../points_raw.raw", "C:\\x.raw", "a%03d.raw", ""};
    for (int i = 0; i < 5; i++) {
        sb_image image;
        sb_error error;
        FILE *file = fopen("build/test_image.mhd", "wb");
        if (!CHECK(file != NULL))
            return;
        fprintf(file, META "DimSize = 2 1 1\nElementType = MET_UCHAR\nElementDataFile = %s\n", elsewhere[i]);
        fclose(file);
        CHECK_RESULT(sb_image_load(&image, "build/test_image.mhd", NULL, &error),
                     i < 4 ? SB_ERROR_UNSUPPORTED : SB_ERROR_FILE);
    }
    remove("build/test_image.mhd");
}

/* sb_mesh_load says what to call instead. */
static void test_not_a_mesh(void)
{
    static const char *const texts[] = {POINTS "DIMENSIONS 2 1 1\n", VTI("", "", "")};
    for (int i = 0; i < 2; i++) {
        sb_mesh mesh;
        sb_error error;
        CHECK_RESULT(sb_mesh_load_memory(&mesh, texts[i], strlen(texts[i]), SB_FILE_AUTO, "x", NULL, &error),
                     SB_ERROR_UNSUPPORTED);
        CHECK(strstr(error.message, "sb_image_load") != NULL && strstr(error.message, "sb_image_surface") != NULL);
    }
    CHECK(!sb_image_is_file("tests/test_image.c") && !sb_image_is_file("no-such-file") && !sb_image_is_file(NULL));
    CHECK(!sb_image_is_file("tests/fuzz/corpus/vtu/case0"));
}

static void test_memory(void)
{
    static const char *const names[] = {"points_short_binary.vtk", "points_raw_zlib.vti", "points_base64.vti",
                                        "points_gzip.nrrd",        "points_raw.mhd",      "points_short_big.nii.gz"};
    for (size_t n = 0; n < sizeof names / sizeof names[0]; n++) {
        sb_result result = SB_ERROR_MEMORY;
        for (int fail_at = 1; result != SB_OK && fail_at < 100; fail_at++) {
            sb_load_options options = sb_default_load_options();
            scene_memory memory;
            char path[256];
            sb_image image;
            memset(&memory, 0, sizeof memory);
            memory.fail_at = fail_at;
            options.allocator = scene_allocator(&memory);
            snprintf(path, sizeof path, "tests/fuzz/corpus/image/%s", names[n]);
            result = sb_image_load(&image, path, &options, NULL);
            if (result == SB_OK)
                sb_image_free(&image);
            else
                CHECK_RESULT(result, SB_ERROR_MEMORY);
            CHECK_INT(memory.live, 0);
        }
        CHECK_RESULT(result, SB_OK);
    }
}

/* Images of one's own are checked. */
static void test_check(void)
{
    int labels[2] = {0, 1};
    sb_image image, bad;
    memset(&image, 0, sizeof image);
    image.counts[0] = 2, image.counts[1] = image.counts[2] = 1;
    image.spacing = sb_v3(1, 1, 1);
    image.direction = sb_m3_identity();
    image.labels = labels;
    CHECK_OK(sb_image_check(&image, NULL));
    bad = image, bad.labels = NULL;
    CHECK_RESULT(sb_image_check(&bad, NULL), SB_ERROR_ARGUMENT);
    bad = image, bad.counts[1] = 0;
    CHECK_RESULT(sb_image_check(&bad, NULL), SB_ERROR_ARGUMENT);
    bad = image, bad.counts[1] = bad.counts[2] = 100000;
    CHECK_RESULT(sb_image_check(&bad, NULL), SB_ERROR_ARGUMENT);
    bad = image, bad.spacing.z = 0;
    CHECK_RESULT(sb_image_check(&bad, NULL), SB_ERROR_ARGUMENT);
    bad = image, bad.spacing.z = (sb_real)INFINITY;
    CHECK_RESULT(sb_image_check(&bad, NULL), SB_ERROR_NOT_FINITE);
    bad = image, bad.direction.m[0][0] = 2;
    CHECK_RESULT(sb_image_check(&bad, NULL), SB_ERROR_ARGUMENT);
    bad = image, bad.direction = sb_m3_columns(sb_v3(1, 0, 0), sb_v3(1, 0, 0), sb_v3(0, 0, 1));
    CHECK_RESULT(sb_image_check(&bad, NULL), SB_ERROR_ARGUMENT);
    CHECK_INT(sb_image_label_at(&image, sb_v3(1, 0, 0)), 1);
    CHECK_INT(sb_image_label_at(&image, sb_v3((sb_real)1.6, 0, 0)), 0);
    CHECK_INT(sb_image_label_at(&image, sb_v3((sb_real)NAN, 0, 0)), 0);
    CHECK_INT(sb_image_label_at(&image, sb_v3(SB_REAL_MAX, 0, 0)), 0);
}

CHECK_SUITE(image, {"files of VTK and by hand", test_files}, {"values of cells", test_cells},
            {"an image that is turned", test_turned}, {"directions", test_directions},
            {"NIfTI, turned", test_nifti_turned}, {"NIfTI, fields out of range", test_nifti_malformed},
            {"NIfTI, axes", test_nifti_axes}, {"NIfTI, packed", test_nifti_packed}, {"malformed files", test_malformed},
            {"files that are cut off", test_truncated}, {"data files elsewhere", test_detached},
            {"images are no meshes", test_not_a_mesh}, {"every allocation failing", test_memory},
            {"images of one's own", test_check});
