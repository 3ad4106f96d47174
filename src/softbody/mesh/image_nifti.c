/* image_nifti: the binary headers of NIfTI. Source: "NIfTI-1 Data Format" and "NIfTI-2" (nifti.nimh.nih.gov). */
#include "meshio_reader.h"

#include <limits.h>
#include <math.h>
#include <string.h>

/* Where a header's fields stand. Numbers of dimensions and their like are 2 bytes in version 1 and 8 in version 2,
 * real numbers 4 and 8. */
typedef struct sbi_nifti_layout {
    int size, magic, version;
    int type, dimensions, spacing, offset, slope, codes, quaternion, shift, rows;
    int integer, real, code; /* bytes of a dimension, of a real number, of a code of the two transforms */
} sbi_nifti_layout;

typedef struct sbi_nifti {
    sbi_reader at; /* of the header's bytes, in their order */
    const sbi_nifti_layout *layout;
    int dimension; /* at most 3 */
} sbi_nifti;

static const sbi_nifti_layout *sbi_nifti_layout_of(const char *data, size_t size, int *big_endian)
{
    static const sbi_nifti_layout layouts[2] = {{348, 344, 1, 70, 40, 76, 108, 112, 252, 256, 268, 280, 2, 4, 2},
                                                {540, 4, 2, 12, 16, 104, 168, 176, 344, 352, 376, 400, 8, 8, 4}};
    for (int version = 0; version < 2; version++) {
        const sbi_nifti_layout *layout = &layouts[version];
        int low = layout->size & 255, high = layout->size >> 8;
        const unsigned char *bytes = (const unsigned char *)data;
        const char *magic; /* n+1, n+2; ni1, ni2: the voxels are in another file */
        if (size < (size_t)layout->size)
            continue;
        magic = data + layout->magic;
        if (magic[0] != 'n' || (magic[1] != '+' && magic[1] != 'i') || magic[2] != '1' + version)
            continue;
        *big_endian = bytes[3] == low && bytes[2] == high;
        if (*big_endian || (bytes[0] == low && bytes[1] == high))
            return layout;
    }
    return NULL;
}

SBI_API int sbi_nifti_begins(const char *data, size_t size)
{
    int big_endian;
    return sbi_nifti_layout_of(data, size, &big_endian) != NULL;
}

static int64_t sbi_nifti_integer(const sbi_nifti *nifti, int at, int size)
{
    return sbi_decode_signed(&nifti->at, (const unsigned char *)nifti->at.data + at, size);
}

static double sbi_nifti_real(const sbi_nifti *nifti, int at, int index)
{
    int size = nifti->layout->real;
    return sbi_decode_float(&nifti->at, (const unsigned char *)nifti->at.data + at + size * index, size);
}

static sb_result sbi_nifti_type(const sbi_nifti *nifti, sbi_voxel_data *data)
{
    static const struct {
        int code;
        char class_;
        int size;
    } types[] = {{2, 'u', 1},   {4, 'i', 2},   {8, 'i', 4},   {16, 'f', 4},   {64, 'f', 8},
                 {256, 'i', 1}, {512, 'u', 2}, {768, 'u', 4}, {1024, 'i', 8}, {1280, 'u', 8}};
    int64_t code = sbi_nifti_integer(nifti, nifti->layout->type, 2);
    for (size_t i = 0; i < sizeof types / sizeof types[0]; i++)
        if (types[i].code == code) {
            data->class_ = types[i].class_;
            data->size = types[i].size;
            return SB_OK;
        }
    return sbi_reader_fail(&nifti->at, SB_ERROR_UNSUPPORTED, "values of data type %d: labels are single numbers",
                           (int)code);
}

/* A fourth axis (time, components) may be there, but not be used. */
static sb_result sbi_nifti_counts(sbi_nifti *nifti, int points[3])
{
    int at = nifti->layout->dimensions, bytes = nifti->layout->integer;
    int64_t axes = sbi_nifti_integer(nifti, at, bytes);
    if (axes < 1 || axes > 7)
        return sbi_reader_fail(&nifti->at, SB_ERROR_FORMAT, "an image of %lld dimensions", (long long)axes);
    for (int axis = 0; axis < (int)axes; axis++) {
        int64_t count = sbi_nifti_integer(nifti, at + bytes * (axis + 1), bytes);
        if (count < 1)
            return sbi_reader_fail(&nifti->at, SB_ERROR_FORMAT, "%lld voxels along axis %d", (long long)count, axis);
        if (axis >= 3 && count > 1)
            return sbi_reader_fail(&nifti->at, SB_ERROR_UNSUPPORTED,
                                   "%lld values per voxel, or volumes: a label image has one", (long long)count);
        if (count > INT_MAX)
            return sbi_reader_fail(&nifti->at, SB_ERROR_UNSUPPORTED, "more than 2147483647 voxels");
        if (axis < 3)
            points[axis] = (int)count;
    }
    for (int axis = (int)axes; axis < 3; axis++)
        points[axis] = 1;
    nifti->dimension = axes < 3 ? (int)axes : 3;
    return SB_OK;
}

/* The rotation of a unit quaternion of which b, c and d are given, its third column turned where pixdim[0] is below 0.
 */
static void sbi_nifti_turn(const sbi_nifti *nifti, double axes[3][3])
{
    double b = sbi_nifti_real(nifti, nifti->layout->quaternion, 0);
    double c = sbi_nifti_real(nifti, nifti->layout->quaternion, 1);
    double d = sbi_nifti_real(nifti, nifti->layout->quaternion, 2);
    double square = b * b + c * c + d * d, a = 0, length = sqrt(square);
    double sign = sbi_nifti_real(nifti, nifti->layout->spacing, 0) < 0 ? -1 : 1;
    if (square < 1)
        a = sqrt(1 - square);
    else
        b /= length, c /= length, d /= length;
    axes[0][0] = a * a + b * b - c * c - d * d;
    axes[0][1] = 2 * (b * c + a * d);
    axes[0][2] = 2 * (b * d - a * c);
    axes[1][0] = 2 * (b * c - a * d);
    axes[1][1] = a * a + c * c - b * b - d * d;
    axes[1][2] = 2 * (c * d + a * b);
    axes[2][0] = sign * 2 * (b * d + a * c);
    axes[2][1] = sign * 2 * (c * d - a * b);
    axes[2][2] = sign * (a * a + d * d - b * b - c * c);
}

/* Method 3 of the standard where it is there: rows of a matrix, whose columns carry the spacing. Else method 2, a turn,
 * or method 1, the spacing alone. */
static sb_result sbi_nifti_place(const sbi_nifti *nifti, sbi_voxels *voxels)
{
    const sbi_nifti_layout *l = nifti->layout;
    int by_turn = sbi_nifti_integer(nifti, l->codes, l->code) > 0;
    int by_rows = sbi_nifti_integer(nifti, l->codes + l->code, l->code) > 0;
    double sum = 0;
    for (int axis = 0; axis < 3 && by_rows; axis++) {
        voxels->origin[axis] = sbi_nifti_real(nifti, l->rows, 4 * axis + 3);
        for (int k = 0; k < 3; k++)
            voxels->direction[k][axis] = sbi_nifti_real(nifti, l->rows, 4 * axis + k);
    }
    for (int axis = 0; axis < 3 && !by_rows; axis++) {
        if (axis < nifti->dimension)
            voxels->spacing[axis] = fabs(sbi_nifti_real(nifti, l->spacing, axis + 1));
        if (by_turn)
            voxels->origin[axis] = sbi_nifti_real(nifti, l->shift, axis);
    }
    if (by_turn && !by_rows)
        sbi_nifti_turn(nifti, voxels->direction);
    for (int axis = 0; axis < 3; axis++) {
        sum += voxels->origin[axis] + voxels->spacing[axis];
        for (int k = 0; k < 3; k++)
            sum += voxels->direction[axis][k];
    }
    if (sum - sum != 0)
        return sbi_reader_fail(&nifti->at, SB_ERROR_NOT_FINITE, "origin, spacing or axes are not finite");
    return sbi_voxels_check_spacing(&nifti->at, voxels->spacing);
}

/* Bytes before the voxels: the header, four bytes and what extensions take. */
static sb_result sbi_nifti_offset(const sbi_nifti *nifti, size_t *offset)
{
    const sbi_nifti_layout *l = nifti->layout;
    double least = l->size + 4, at = l->version == 1 ? sbi_nifti_real(nifti, l->offset, 0)
                                                     : (double)sbi_nifti_integer(nifti, l->offset, l->integer);
    if (at == 0)
        at = least; /* as some programs leave it */
    if (!(at >= least) || !(at < 9007199254740992.0) || floor(at) < at)
        return sbi_reader_fail(&nifti->at, SB_ERROR_FORMAT, "the voxels begin at byte %g", at);
    if (at > (double)(((size_t)-1) / 2))
        return sbi_reader_fail(&nifti->at, SB_ERROR_UNSUPPORTED, "the voxels begin at byte %g", at);
    *offset = (size_t)at;
    return SB_OK;
}

SBI_API sb_result sbi_nifti_read(const sbi_reader *header, sbi_voxels *voxels, sbi_voxel_data *data)
{
    sbi_nifti nifti;
    sb_result result;
    nifti.at = *header;
    nifti.at.at = 0;
    nifti.at.binary = 1;
    nifti.dimension = 0;
    nifti.layout = sbi_nifti_layout_of(header->data, header->size, &nifti.at.big_endian);
    data->big_endian = nifti.at.big_endian;
    if (!nifti.layout || header->data[nifti.layout->magic + 1] != '+')
        return sbi_reader_fail(&nifti.at, SB_ERROR_UNSUPPORTED,
                               "a NIfTI header whose voxels are in another file: save it as one file (.nii)");
    result = sbi_nifti_type(&nifti, data);
    if (!result)
        result = sbi_nifti_counts(&nifti, voxels->points);
    if (!result)
        result = sbi_nifti_place(&nifti, voxels);
    if (!result)
        result = sbi_nifti_offset(&nifti, &data->offset);
    data->slope = sbi_nifti_real(&nifti, nifti.layout->slope, 0);
    data->shift = sbi_nifti_real(&nifti, nifti.layout->slope, 1);
    if (data->slope - data->slope != 0 || data->shift - data->shift != 0)
        data->slope = 0; /* as some programs mark that there is none */
    return result;
}
