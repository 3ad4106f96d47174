/* image: label images, as segmentations come. Floor 1: calls base and the readers of meshio.
 *
 *     sb_image image;
 *     if (sb_image_load(&image, "liver.mha", &options, &error) != SB_OK) ...     options.scale = 0.001: millimetres
 *     sb_image_surface (surface of a label), sb_image_set_regions (labels of a mesh's elements): see labels.h
 *     sb_image_free(&image);
 *
 * | format     | read                                                                                   |
 * |------------|----------------------------------------------------------------------------------------|
 * | VTK legacy | STRUCTURED_POINTS, 2.0 to 5.1, ASCII and binary, all numeric types                     |
 * | VTI        | VTK's XML ImageData in one piece: ASCII, base64, appended, zlib-compressed              |
 * | MetaImage  | .mha, .mhd with one data file: raw of both byte orders, ASCII, zlib-compressed          |
 * | NRRD       | .nrrd, .nhdr with one data file: raw of both byte orders, ASCII, gzip                   |
 * | NIfTI      | .nii, .nii.gz, versions 1 and 2 of both byte orders, in one file                        |
 *
 * Coordinates are the file's own times `scale`: NIfTI's x, y, z point right, forward and up (of the patient), those of
 * DICOM and most MetaImages left, back and up; an NRRD's header says which (`space`). Almost all are in millimetres.
 * A file is untrusted input, see meshio.h. */
#ifndef SB_IMAGE_H
#define SB_IMAGE_H

#include "meshio.h"

/* A box of voxels, each with a label; 0 is background. Fill it yourself or load it; zero-initialise. The centre of
 * voxel (i, j, k) lies at origin + direction (i spacing.x, j spacing.y, k spacing.z). */
typedef struct sb_image {
    int counts[3];          /* voxels along i, j, k; each >= 1, their product at most 2147483647 */
    sb_vec3 origin;         /* (m) centre of voxel (0, 0, 0) */
    sb_vec3 spacing;        /* (m) > 0, between the centres of neighbours */
    sb_mat3 direction;      /* columns: unit vectors along i, j, k, not in one plane; left-handed ones are fine */
    int *labels;            /* [counts[2]][counts[1]][counts[0]], i fastest */
    sb_allocator allocator; /* what labels came from; zeros: malloc */
} sb_image;

/* Reads a label image; the format follows from the content.
 *
 * image    overwritten on success (free it first when it owns labels), untouched on failure; sb_image_free
 * options  scale (multiplies origin and spacing) and allocator are read; NULL: sb_default_load_options()
 * error    may be NULL; file and line (line 0 in binary parts, where the message has the byte offset)
 *
 * VTK files: the first array of one number per point (or cell, where no point has one) is taken. Images of two
 * dimensions have one layer of voxels. Values of any numeric type are taken where they are whole numbers that fit an
 * int. Header files (.mhd, .nhdr) name their data file, which is looked for beside them, and nowhere else.
 *
 * SB_ERROR_ARGUMENT, _FILE, _FORMAT (also: data cut off, more of it than the header says, a value that is no label),
 * _NOT_FINITE (origin, spacing, a value), _UNSUPPORTED (names what: more dimensions, vectors, a compression, pieces),
 * _MEMORY. */
SB_API sb_result sb_image_load(sb_image *image, const char *path, const sb_load_options *options, sb_error *error);
/* The same from data[size] in memory, borrowed during the call; files that name a data file are SB_ERROR_UNSUPPORTED.
 * name stands for the path in errors; may be NULL. */
SB_API sb_result sb_image_load_memory(sb_image *image, const void *data, size_t size, const char *name,
                                      const sb_load_options *options, sb_error *error);
/* 1 when the file begins as a label image does: to choose between sb_image_load and sb_mesh_load. 0 also for a file
 * that cannot be read. */
SB_API int sb_image_is_file(const char *path);
/* Releases the labels and zeroes the struct. Safe on {0} and on NULL. */
SB_API void sb_image_free(sb_image *image);

/* Whether the fields are as described above: SB_ERROR_ARGUMENT (names the field), _NOT_FINITE. */
SB_API sb_result sb_image_check(const sb_image *image, sb_error *error);
/* The smallest label above `after`: 1 and *label, or 0 when there is none. O(voxels). All labels but background:
 *     for (int label = 0; sb_image_next_label(&image, label, &label);) ...   (those below 0: start at INT_MIN) */
SB_API int sb_image_next_label(const sb_image *image, int after, int *label);
/* Label of the voxel that holds the point (m); 0 outside the image. Labels of many points: sb_image_set_regions. */
SB_API int sb_image_label_at(const sb_image *image, sb_vec3 point);

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* Position of the point with the coordinates i, j, k, and the way back. */
typedef struct sbi_image_frame {
    sb_mat3 axes, inverse; /* columns of axes: from a voxel to the next */
    sb_vec3 origin;
} sbi_image_frame;
SBI_API sbi_image_frame sbi_image_get_frame(const sb_image *image);
/* Label at the point, 0 outside. */
SBI_API int sbi_image_lookup(const sb_image *image, const sbi_image_frame *frame, sb_vec3 point);
#endif

#endif /* SB_IMAGE_H */
