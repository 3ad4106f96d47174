/* meshio_voxels: what all readers of images share: where voxels go, and checks of what is said about them. */
#include "meshio_reader.h"

#include <limits.h>
#include <string.h>

SBI_API void sbi_voxels_init(sbi_voxels *voxels)
{
    memset(voxels, 0, sizeof *voxels);
    for (int k = 0; k < 3; k++)
        voxels->spacing[k] = voxels->direction[k][k] = 1;
}

SBI_API sb_result sbi_voxels_read_reals(sbi_reader *reader, const char *what, int count, double *values)
{
    double read[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
    sb_result result = SB_OK;
    for (int i = 0; i < count && !result; i++)
        result = sbi_reader_real(reader, what, &read[i]);
    if (!result)
        memcpy(values, read, (size_t)count * sizeof *values);
    return result;
}

SBI_API sb_result sbi_voxels_check_spacing(const sbi_reader *reader, const double spacing[3])
{
    for (int k = 0; k < 3; k++)
        if (!(spacing[k] > 0))
            return sbi_reader_fail(reader, SB_ERROR_FORMAT, "a spacing of %g: it must be above 0", spacing[k]);
    return SB_OK;
}

/* Voxels along an axis. A direction with one point only has one layer of cells all the same. */
static int sbi_voxels_along(int points, int in_cells) { return in_cells && points > 1 ? points - 1 : points; }

SBI_API int sbi_voxels_count(const sbi_voxels *voxels, int in_cells)
{
    int64_t count = 1;
    for (int k = 0; k < 3; k++) {
        count *= sbi_voxels_along(voxels->points[k], in_cells);
        if (count > INT_MAX)
            return 0;
    }
    return (int)count;
}

SBI_API sb_result sbi_voxels_begin(sbi_loader *loader, int in_cells)
{
    sbi_voxels *voxels = loader->voxels;
    int count = sbi_voxels_count(voxels, in_cells);
    if (count == 0)
        return sbi_reader_fail(&loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 voxels, or none");
    voxels->labels = (int *)sbi_alloc(&loader->allocator, (size_t)count, sizeof(int));
    if (!voxels->labels)
        return sbi_loader_no_memory(loader);
    for (int axis = 0; axis < 3; axis++) {
        int points = voxels->points[axis];
        voxels->counts[axis] = sbi_voxels_along(points, in_cells);
        for (int k = 0; k < 3 && voxels->counts[axis] < points; k++) /* from the first corner to the first centre */
            voxels->origin[k] += 0.5 * voxels->spacing[axis] * voxels->direction[axis][k];
    }
    return SB_OK;
}

SBI_API sb_result sbi_voxels_set(const sbi_loader *loader, const sbi_reader *reader, int voxel, double value)
{
    if (value - value != 0)
        return sbi_reader_fail(reader, SB_ERROR_NOT_FINITE, "voxel %d is not finite", voxel);
    if (value < (double)INT_MIN || value > (double)INT_MAX || floor(value) < value)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT,
                               "voxel %d is %g: labels are whole numbers that an int holds (is this a label image?)",
                               voxel, value);
    loader->voxels->labels[voxel] = (int)value;
    return SB_OK;
}
