/* image: label images, their files as a whole, and how points find their voxels. */
#include "image.h"

#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "meshio_reader.h"

/* ==== data behind a header ============================================================================ */

static sb_result sbi_voxels_read_text(sbi_loader *loader, sbi_reader *reader, int count)
{
    sbi_word word;
    sb_result result = sbi_reader_check_count(reader, "the number of voxels", count, 2, &count);
    if (!result)
        result = sbi_voxels_begin(loader, 0);
    for (int i = 0; i < count && !result; i++) {
        double value = 0;
        result = sbi_reader_real(reader, "label", &value);
        if (!result)
            result = sbi_voxels_set(loader, reader, i, value);
    }
    if (!result && sbi_reader_word(reader, &word))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file has more numbers than the %d voxels need", count);
    return result;
}

/* The voxels are all that `reader` has left. */
static sb_result sbi_voxels_read_raw(sbi_loader *loader, sbi_reader *reader, const sbi_voxel_data *data, int count)
{
    size_t left = sbi_reader_left(reader), size = (size_t)data->size;
    const unsigned char *bytes;
    sb_result result;
    if (left / size < (size_t)count)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "%d voxels of %d bytes are announced, but %llu bytes are there",
                               count, data->size, (unsigned long long)left);
    if (left != (size_t)count * size)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "%llu bytes follow the %d voxels",
                               (unsigned long long)(left - (size_t)count * size), count);
    bytes = sbi_reader_bytes(reader, (size_t)count, size, "the voxels");
    result = sbi_voxels_begin(loader, 0);
    for (int i = 0; i < count && !result; i++, bytes += size) {
        double value = data->class_ == 'f'   ? sbi_decode_float(reader, bytes, data->size)
                       : data->class_ == 'i' ? (double)sbi_decode_signed(reader, bytes, data->size)
                                             : (double)sbi_decode_bits(reader, bytes, data->size);
        result = sbi_voxels_set(loader, reader, i, data->slope != 0 ? data->shift + data->slope * value : value);
    }
    return result;
}

static sb_result sbi_voxels_read_packed(sbi_loader *loader, sbi_reader *reader, const sbi_voxel_data *data, int count)
{
    const unsigned char *bytes = (const unsigned char *)reader->data + reader->at;
    size_t size = 0, capacity = 0, limit = 0;
    unsigned char *out = NULL;
    const char *wrong =
        sbi_size_add(&limit, (size_t)count, (size_t)data->size) && sbi_size_add(&limit, data->offset, 1) ? NULL : "";
    sb_result result;
    if (!wrong)
        wrong = (data->encoding == SBI_VOXELS_GZIP ? sbi_gunzip : sbi_inflate)(
            &loader->allocator, bytes, sbi_reader_left(reader), limit, &out, &size, &capacity);
    if (wrong && !wrong[0])
        result = sbi_loader_no_memory(loader);
    else if (wrong)
        result = sbi_reader_fail(reader, SB_ERROR_FORMAT, "the packed voxels cannot be unpacked: %s", wrong);
    else {
        sbi_reader unpacked = *reader;
        unpacked.data = out ? (const char *)out : "";
        unpacked.size = size;
        unpacked.at = data->offset < size ? data->offset : size;
        result = sbi_voxels_read_raw(loader, &unpacked, data, count);
    }
    sbi_free(&loader->allocator, out);
    return result;
}

/* Reads what a header described from the reader's place to its end. */
static sb_result sbi_voxels_read_data(sbi_loader *loader, sbi_reader *reader, const sbi_voxel_data *data)
{
    int count = sbi_voxels_count(loader->voxels, 0);
    if (count == 0)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 voxels, or none");
    if (data->encoding == SBI_VOXELS_TEXT)
        return sbi_voxels_read_text(loader, reader, count);
    reader->binary = 1;
    reader->big_endian = data->big_endian;
    if (data->encoding == SBI_VOXELS_RAW && data->offset > 0)
        reader->at = data->offset < reader->size ? data->offset : reader->size;
    return data->encoding == SBI_VOXELS_RAW ? sbi_voxels_read_raw(loader, reader, data, count)
                                            : sbi_voxels_read_packed(loader, reader, data, count);
}

/* ==== files =========================================================================================== */

typedef enum sbi_image_format {
    SBI_IMAGE_NONE = 0,
    SBI_IMAGE_VTK = 1,
    SBI_IMAGE_VTI = 2,
    SBI_IMAGE_META = 3,
    SBI_IMAGE_NRRD = 4,
    SBI_IMAGE_NIFTI = 5,
    SBI_IMAGE_PACKED = 6 /* by gzip: a NIfTI file, or of no use */
} sbi_image_format;

static int sbi_image_begins(const char *data, size_t size, const char *text)
{
    size_t length = strlen(text);
    return size >= length && memcmp(data, text, length) == 0;
}

/* By what the file begins with: whether it may be an image is for its reader to say. */
static sbi_image_format sbi_image_detect(const char *data, size_t size)
{
    if (sbi_image_begins(data, size, "# vtk DataFile"))
        return SBI_IMAGE_VTK;
    if (sbi_image_begins(data, size, "NRRD000"))
        return SBI_IMAGE_NRRD;
    if (sbi_image_begins(data, size, "ObjectType") || sbi_image_begins(data, size, "NDims"))
        return SBI_IMAGE_META;
    if (sbi_image_begins(data, size, "\x1F\x8B"))
        return SBI_IMAGE_PACKED;
    if (sbi_nifti_begins(data, size))
        return SBI_IMAGE_NIFTI;
    while (size > 0 && (*data == ' ' || *data == '\n' || *data == '\r' || *data == '\t'))
        data++, size--;
    return size > 0 && *data == '<' ? SBI_IMAGE_VTI : SBI_IMAGE_NONE;
}

/* 1 when `text` stands among the first bytes. */
static int sbi_image_has(const char *data, size_t size, const char *text)
{
    size_t length = strlen(text);
    for (size_t i = 0; i + length <= size; i++)
        if (memcmp(data + i, text, length) == 0)
            return 1;
    return 0;
}

/* 1 when what is packed begins as a NIfTI file does; `start` is all that is known of it. */
static int sbi_image_is_packed(const char *start, size_t size)
{
    sb_allocator allocator;
    unsigned char *out;
    size_t out_size;
    int is;
    memset(&allocator, 0, sizeof allocator);
    sbi_gunzip_start(&allocator, (const unsigned char *)start, size, SBI_NIFTI_HEADER, &out, &out_size);
    is = sbi_nifti_begins((const char *)out, out_size);
    sbi_free(&allocator, out);
    return is;
}

SB_API int sb_image_is_file(const char *path)
{
    char start[1024]; /* the title line of VTK's files has at most 256 characters, NIfTI's header 540 bytes */
    FILE *file = path ? fopen(path, "rb") : NULL;
    size_t size;
    if (!file)
        return 0;
    size = fread(start, 1, sizeof start, file);
    fclose(file);
    switch (sbi_image_detect(start, size)) {
    case SBI_IMAGE_VTK: return sbi_image_has(start, size, "STRUCTURED_POINTS");
    case SBI_IMAGE_VTI: return sbi_image_has(start, size, "ImageData");
    case SBI_IMAGE_PACKED: return sbi_image_is_packed(start, size);
    case SBI_IMAGE_META:
    case SBI_IMAGE_NRRD:
    case SBI_IMAGE_NIFTI: return 1;
    case SBI_IMAGE_NONE: break;
    }
    return 0;
}

/* The path of a file beside another one; NULL without memory. */
static char *sbi_image_beside(const sb_allocator *allocator, const char *path, sbi_word name)
{
    size_t folder = 0;
    char *joined;
    for (size_t i = 0; path[i]; i++)
        if (path[i] == '/' || path[i] == '\\')
            folder = i + 1;
    joined = (char *)sbi_alloc(allocator, folder + name.length + 1, 1);
    if (joined) {
        memcpy(joined, path, folder);
        memcpy(joined + folder, name.text, name.length);
        joined[folder + name.length] = 0;
    }
    return joined;
}

/* The voxels of a header file, which is untrusted: it must not make us open whatever it likes. */
static sb_result sbi_image_read_detached(sbi_loader *loader, const sbi_voxel_data *data, const char *path)
{
    sbi_file content;
    sbi_reader reader;
    char *name, text[32];
    sb_result result;
    if (!path)
        return sbi_reader_fail(&loader->reader, SB_ERROR_UNSUPPORTED,
                               "the voxels are in the file %s: load the header by its path",
                               sbi_word_print(data->file, text));
    for (size_t i = 0; i < data->file.length; i++)
        if (strchr("/\\:", data->file.text[i])) /* also a NUL */
            return sbi_reader_fail(&loader->reader, SB_ERROR_UNSUPPORTED,
                                   "the data file %s is not beside the header: only those are read",
                                   sbi_word_print(data->file, text));
    name = sbi_image_beside(&loader->allocator, path, data->file);
    if (!name)
        return sbi_loader_no_memory(loader);
    result = sbi_file_read(&loader->allocator, name, &content, loader->reader.error);
    if (!result) {
        sbi_reader_init(&reader, content.data, content.size, name, loader->reader.error);
        result = sbi_voxels_read_data(loader, &reader, data);
    }
    sbi_free(&loader->allocator, content.data);
    sbi_free(&loader->allocator, name);
    return result;
}

/* The header of a NIfTI file that is packed as a whole. Another packed file is an error. */
static sb_result sbi_image_read_packed(sbi_loader *loader, sbi_voxel_data *data)
{
    sbi_reader header = loader->reader;
    unsigned char *start;
    sb_result result;
    if (!sbi_gunzip_start(&loader->allocator, (const unsigned char *)header.data, header.size, SBI_NIFTI_HEADER, &start,
                          &header.size))
        result = sbi_loader_no_memory(loader);
    else if (!sbi_nifti_begins((const char *)start, header.size))
        result = sbi_reader_check_kind(&loader->reader);
    else {
        header.data = (const char *)start;
        data->encoding = SBI_VOXELS_GZIP;
        result = sbi_nifti_read(&header, loader->voxels, data);
    }
    sbi_free(&loader->allocator, start);
    return result;
}

static sb_result sbi_image_parse(sbi_loader *loader, const char *path)
{
    sbi_reader *reader = &loader->reader;
    sbi_image_format format = sbi_image_detect(reader->data, reader->size);
    sbi_voxel_data data;
    sb_result result = format == SBI_IMAGE_PACKED ? SB_OK : sbi_reader_check_kind(reader);
    memset(&data, 0, sizeof data);
    if (result)
        return result;
    switch (format) {
    case SBI_IMAGE_VTK: return sbi_vtk_read(loader);
    case SBI_IMAGE_VTI: return sbi_vtu_read(loader);
    case SBI_IMAGE_META: result = sbi_meta_read(loader, &data); break;
    case SBI_IMAGE_NRRD: result = sbi_nrrd_read(loader, &data); break;
    case SBI_IMAGE_NIFTI: result = sbi_nifti_read(reader, loader->voxels, &data); break;
    case SBI_IMAGE_PACKED: result = sbi_image_read_packed(loader, &data); break;
    default:
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file is %s",
                               reader->size ? "no image of VTK's, no MetaImage, NRRD or NIfTI" : "empty");
    }
    if (result)
        return result;
    return data.has_file ? sbi_image_read_detached(loader, &data, path) : sbi_voxels_read_data(loader, reader, &data);
}

/* What was read, scaled and with axes of length 1, as an image. */
static sb_result sbi_image_make(sbi_loader *loader, sb_image *image)
{
    sbi_voxels *voxels = loader->voxels;
    sb_real *origin[3], *spacing[3];
    sb_image made;
    sb_error error;
    if (!voxels->labels)
        return sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT,
                               "the image has no array of one number per point or cell");
    memset(&made, 0, sizeof made);
    origin[0] = &made.origin.x, origin[1] = &made.origin.y, origin[2] = &made.origin.z;
    spacing[0] = &made.spacing.x, spacing[1] = &made.spacing.y, spacing[2] = &made.spacing.z;
    for (int axis = 0; axis < 3; axis++) {
        const double *d = voxels->direction[axis];
        double length = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        double room = (double)SB_REAL_MAX, o = voxels->origin[axis] * loader->scale;
        double s = voxels->spacing[axis] * loader->scale * length;
        if (!(length > 0) || !(fabs(o) <= room) || !(s <= room))
            return sbi_reader_fail(&loader->reader, SB_ERROR_NOT_FINITE,
                                   "axis %d: a direction of length %g, spacing %g, origin %g", axis, length, s, o);
        made.counts[axis] = voxels->counts[axis];
        *origin[axis] = (sb_real)o;
        *spacing[axis] = (sb_real)s;
        for (int k = 0; k < 3; k++)
            made.direction.m[k][axis] = (sb_real)(d[k] / length);
    }
    made.labels = voxels->labels;
    made.allocator = loader->allocator;
    if (sb_image_check(&made, &error) != SB_OK)
        return sbi_reader_fail(&loader->reader, error.result == SB_ERROR_ARGUMENT ? SB_ERROR_FORMAT : error.result,
                               "%s", error.message);
    voxels->labels = NULL;
    *image = made;
    return SB_OK;
}

/* path: NULL when the content came from memory. */
static sb_result sbi_image_read(sb_image *image, const char *data, size_t size, const char *name, const char *path,
                                const sb_load_options *options, sb_error *error)
{
    sbi_loader loader;
    sbi_voxels voxels;
    sb_result result;
    sbi_voxels_init(&voxels);
    sbi_loader_init(&loader, options, error);
    loader.voxels = &voxels;
    sbi_loader_set_content(&loader, data, size, name);
    result = sbi_image_parse(&loader, path);
    if (!result)
        result = sbi_image_make(&loader, image);
    sbi_free(&loader.allocator, voxels.labels);
    sbi_loader_free(&loader);
    return result;
}

SB_API sb_result sb_image_load_memory(sb_image *image, const void *data, size_t size, const char *name,
                                      const sb_load_options *options, sb_error *error)
{
    sb_load_options resolved;
    sb_result result = sbi_load_options_resolve(options, &resolved, error);
    if (result)
        return result;
    if (!image || (!data && size))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", image ? "data" : "image");
    return sbi_image_read(image, size ? (const char *)data : "", size, name, NULL, &resolved, error);
}

SB_API sb_result sb_image_load(sb_image *image, const char *path, const sb_load_options *options, sb_error *error)
{
    sb_load_options resolved;
    sbi_file content;
    sb_result result = sbi_load_options_resolve(options, &resolved, error);
    if (result)
        return result;
    if (!image || !path)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", image ? "path" : "image");
    result = sbi_file_read(&resolved.allocator, path, &content, error);
    if (!result)
        result = sbi_image_read(image, content.data, content.size, path, path, &resolved, error);
    sbi_free(&resolved.allocator, content.data);
    return result;
}

SB_API void sb_image_free(sb_image *image)
{
    if (!image)
        return;
    sbi_free(&image->allocator, image->labels);
    memset(image, 0, sizeof *image);
}

/* ==== images ========================================================================================== */

/* How flat the axes may lie: the volume of the parallelepiped of their unit vectors. */
#define SBI_IMAGE_LEAST_VOLUME 1e-3

SB_API sb_result sb_image_check(const sb_image *image, sb_error *error)
{
    int64_t count = 1;
    sb_vec3 s;
    if (!image || !image->labels)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", image ? "labels" : "image");
    for (int axis = 0; axis < 3; axis++) {
        if (image->counts[axis] < 1)
            return sbi_fail(error, SB_ERROR_ARGUMENT, "counts[%d] is %d", axis, image->counts[axis]);
        count *= image->counts[axis];
        if (count > INT_MAX)
            return sbi_fail(error, SB_ERROR_ARGUMENT, "counts: more than 2147483647 voxels");
    }
    s = image->spacing;
    if (!sb_v3_is_finite(image->origin) || !sb_v3_is_finite(s))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "origin or spacing is not finite");
    if (!(s.x > 0) || !(s.y > 0) || !(s.z > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "spacing: %g %g %g must be above 0", (double)s.x, (double)s.y,
                        (double)s.z);
    for (int axis = 0; axis < 3; axis++) {
        sb_vec3 d = sb_m3_column(image->direction, axis);
        if (!sb_v3_is_finite(d))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "direction: column %d is not finite", axis);
        if (!(fabs((double)sb_v3_dot(d, d) - 1) < 1e-3))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "direction: column %d is not of length 1", axis);
    }
    if (!(fabs((double)sb_m3_det(image->direction)) >= SBI_IMAGE_LEAST_VOLUME))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "direction: the axes lie in a plane");
    if (!(s.x * (sb_real)image->counts[0] + s.y * (sb_real)image->counts[1] + s.z * (sb_real)image->counts[2] <=
          SB_REAL_MAX / 4))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "spacing: the image is larger than numbers reach");
    return SB_OK;
}

SB_API int sb_image_next_label(const sb_image *image, int after, int *label)
{
    int found = 0, next = 0;
    size_t count;
    if (!label || sb_image_check(image, NULL) != SB_OK)
        return 0;
    count = (size_t)image->counts[0] * (size_t)image->counts[1] * (size_t)image->counts[2];
    for (size_t i = 0; i < count; i++) {
        int value = image->labels[i];
        if (value > after && (!found || value < next)) {
            next = value;
            found = 1;
        }
    }
    if (found)
        *label = next;
    return found;
}

SBI_API sbi_image_frame sbi_image_get_frame(const sb_image *image)
{
    const sb_mat3 *d = &image->direction;
    sb_mat3 turn = sb_m3_inverse(*d);
    sbi_image_frame frame;
    frame.origin = image->origin;
    frame.axes = sb_m3_columns(sb_v3_scale(image->spacing.x, sb_m3_column(*d, 0)),
                               sb_v3_scale(image->spacing.y, sb_m3_column(*d, 1)),
                               sb_v3_scale(image->spacing.z, sb_m3_column(*d, 2)));
    for (int k = 0; k < 3; k++) {
        frame.inverse.m[0][k] = turn.m[0][k] / image->spacing.x;
        frame.inverse.m[1][k] = turn.m[1][k] / image->spacing.y;
        frame.inverse.m[2][k] = turn.m[2][k] / image->spacing.z;
    }
    return frame;
}

SBI_API int sbi_image_lookup(const sb_image *image, const sbi_image_frame *frame, sb_vec3 point)
{
    sb_vec3 at = sb_m3_apply(frame->inverse, sb_v3_sub(point, frame->origin));
    sb_real along[3];
    size_t index[3];
    along[0] = at.x, along[1] = at.y, along[2] = at.z;
    for (int k = 0; k < 3; k++) {
        sb_real cell = along[k] + (sb_real)0.5; /* voxels reach half a spacing around their centres */
        if (!(cell >= 0) || !(cell < (sb_real)image->counts[k]))
            return 0;
        index[k] = (size_t)cell;
    }
    return image->labels[(index[2] * (size_t)image->counts[1] + index[1]) * (size_t)image->counts[0] + index[0]];
}

SB_API int sb_image_label_at(const sb_image *image, sb_vec3 point)
{
    sbi_image_frame frame;
    if (!sb_v3_is_finite(point) || sb_image_check(image, NULL) != SB_OK)
        return 0;
    frame = sbi_image_get_frame(image);
    return sbi_image_lookup(image, &frame, point);
}
#undef SBI_IMAGE_LEAST_VOLUME
