/* cloud: point clouds: files, normals, thinning, outliers. Floor 6.
 *
 *     reg_cloud cloud;
 *     if (reg_cloud_load(&cloud, "scan.ply", 1, NULL, &error) != SB_OK) ...
 *     reg_cloud_remove_outliers(&cloud, 8, REG_OUTLIERS_DEVIATION, 2, NULL, &error);
 *     reg_cloud_estimate_normals(&cloud, 12, &camera, NULL, &error);
 *     reg_cloud_free(&cloud);
 *
 * Everything here is deterministic and takes O(count log count), one to four seconds per million points and step. */
#ifndef REG_CLOUD_H
#define REG_CLOUD_H

#include "../softbody/geometry/surface.h"
#include "kdtree.h"

/* Points with normals or without. Its arrays come from its allocator; fill them by hand only with memory of that. */
typedef struct reg_cloud {
    sb_vec3 *points;  /* [count], m */
    sb_vec3 *normals; /* [count], unit length (0: none known), or NULL */
    int count;
    sb_allocator allocator;
} reg_cloud;

/* Frees the arrays and leaves zeros; accepts NULL and a cloud of zeros. */
REG_API void reg_cloud_free(reg_cloud *cloud);

/* ---- making ------------------------------------------------------------------------------------------------------
 * Each overwrites *cloud on success (free it first when it owns arrays) and leaves it untouched on failure.
 * `allocator` NULL: malloc. */

/* Copies points[count] (count >= 1) and normals[count] (or NULL; made unit length). SB_ERROR_ARGUMENT, _NOT_FINITE
 * (error->node), _MEMORY. */
REG_API sb_result reg_cloud_from_points(reg_cloud *cloud, const sb_vec3 *points, const sb_vec3 *normals, int count,
                                        const sb_allocator *allocator, sb_error *error);

/* The nodes of a mesh. Of a surface (tri3 .. quad9) with normals: the mean of the faces around, weighted by area, 0
 * where there is none; of a volume without. Fails as sb_surface_create does. */
REG_API sb_result reg_cloud_from_mesh(reg_cloud *cloud, const sb_mesh *mesh, const sb_allocator *allocator,
                                      sb_error *error);

typedef enum reg_cloud_format {
    REG_CLOUD_AUTO = 0, /* by the content, else by the end of the name */
    REG_CLOUD_XYZ = 1,  /* text: a point per line, `x y z` or `x y z nx ny nz` between blanks, or commas, or
                         * semicolons; between semicolons decimal commas are read as well. A line that could mean two
                         * things (`0,5 0,25 1,5`) is an error. More columns are left alone, and so are columns 4 to 6
                         * when those of the first point have not about unit length (colours). # and // begin comments;
                         * a first line without any number is a heading, one with a single whole number the count of
                         * points, which must be right */
    REG_CLOUD_PLY = 2,  /* ASCII or binary of both byte orders; of the vertices x y z and, when all are there, nx ny nz;
                         * everything else is stepped over */
    REG_CLOUD_MESH = 3  /* the nodes of any file that sb_mesh_load reads (but TetGen's), with or without cells */
} reg_cloud_format;

/* Reads a cloud from a file; every coordinate is multiplied by `scale` (> 0; files in millimetres: 0.001). A normal is
 * made unit length, and 0 where its length is 0. SB_ERROR_ARGUMENT, _FILE (cannot be read), _FORMAT (also: no points),
 * _NOT_FINITE, _UNSUPPORTED, _MEMORY; error says file and line, in binary parts the byte, and error->node the point. */
REG_API sb_result reg_cloud_load(reg_cloud *cloud, const char *path, sb_real scale, const sb_allocator *allocator,
                                 sb_error *error);
/* The same from memory: data[size], borrowed during the call. name stands for the path in errors and in telling the
 * format; may be NULL. */
REG_API sb_result reg_cloud_load_memory(reg_cloud *cloud, const void *data, size_t size, reg_cloud_format format,
                                        const char *name, sb_real scale, const sb_allocator *allocator,
                                        sb_error *error);

/* Writes a PLY file, binary little-endian in the precision of sb_real or ASCII with all digits, with normals when there
 * are. SB_ERROR_ARGUMENT, _NOT_FINITE, and _FILE as for the writers of meshes. */
REG_API sb_result reg_cloud_save_ply(const char *path, const reg_cloud *cloud, int ascii, sb_error *error);

/* ---- normals ----------------------------------------------------------------------------------------------------- */

/* Gives the cloud normals (in place of any it had): across the plane fitted to each point and its k nearest (k >= 3;
 * 8 to 20 is usual). With a view point they face it. With view NULL neighbours are made to agree, each following the
 * one it is most parallel to (Hoppe et al. 1992), and the highest point (largest z) of each connected part looks up:
 * outward for closed surfaces. 0 where points are so few, or so much in one line or place, that there is no plane.
 * jobs: NULL: inline; only the fits run on it. SB_ERROR_ARGUMENT, _NOT_FINITE, _MEMORY: the cloud is untouched. */
REG_API sb_result reg_cloud_estimate_normals(reg_cloud *cloud, int k, const sb_vec3 *view, const sb_jobs *jobs,
                                             sb_error *error);

/* ---- thinning ---------------------------------------------------------------------------------------------------- */

/* One point for each cube [i, i+1) x [j, j+1) x [k, k+1) times `size` (m, > 0) that holds any: the mean of its points,
 * and of their normals made unit length. In the order in which the cubes were met first. SB_ERROR_ARGUMENT,
 * _NOT_FINITE, _MEMORY; *thin (may be the same as cloud: then replaced) is untouched on failure. */
REG_API sb_result reg_cloud_thin(const reg_cloud *cloud, sb_real size, reg_cloud *thin, sb_error *error);

/* `wanted` points (or all) of points[count], evenly spread: first the one farthest from their mean, then always the one
 * farthest from those chosen. Their indices go to chosen[wanted]; scratch[count]. Returns how many: fewer where points
 * coincide. The same for any pose up to rounding. O(wanted count). No allocation. */
REG_API int reg_cloud_spread(const sb_vec3 *points, int count, int wanted, int *chosen, sb_real *scratch);

/* ---- outliers ---------------------------------------------------------------------------------------------------- */

typedef enum reg_outliers {
    REG_OUTLIERS_NONE = 0,
    REG_OUTLIERS_DEVIATION = 1, /* beyond mean + parameter * standard deviation; 2 */
    REG_OUTLIERS_MEDIAN = 2,    /* beyond median + parameter * 1.4826 * median |d - median|; 3 */
    REG_OUTLIERS_TRIM = 3       /* all but the smallest share `parameter`, in (0, 1]; 0.8 */
} reg_outliers;

/* The largest of distances[count] that is no outlier may be so large; keep d <= limit. Distances that are not finite
 * (points without a partner) are outliers by themselves and do not count. scratch[count]. SB_REAL_MAX for NONE, -1 when
 * no distance counts or the rule or parameter is out of range. O(count), no allocation. */
REG_API sb_real reg_outlier_limit(const sb_real *distances, int count, reg_outliers rule, sb_real parameter,
                                  sb_real *scratch);

/* Takes out points whose mean distance to their k nearest (k >= 1) is an outlier by the rule; the others keep their
 * order. *removed (or NULL): how many. SB_ERROR_ARGUMENT, _NOT_FINITE, _MEMORY: the cloud is untouched. */
REG_API sb_result reg_cloud_remove_outliers(reg_cloud *cloud, int k, reg_outliers rule, sb_real parameter, int *removed,
                                            sb_error *error);

/* ---- noise ------------------------------------------------------------------------------------------------------- */

/* What smoothing found. */
typedef struct reg_smooth_info {
    sb_real noise; /* m: standard deviation of the points across the surface */
    sb_real left;  /* m: what smoothing left of it */
    int outliers;  /* points that belong to nothing */
} reg_smooth_info;

/* Takes noise off a cloud: each point goes to where quadratics fitted to its neighbours say the surface is, over as
 * many neighbours (16 to 128) as agree with one another up to the noise, which is measured first, robustly: flat parts
 * are smoothed widely, edges keep their shape. Where noise is under a twenty-fifth of the points' spacing none moves.
 * Outliers are removed: points farther from a robust fit to their neighbours than 4 standard deviations of the noise
 * and the points' spacing, 2.5 times as far from the next points as those are from theirs, or amid scattered ones.
 * Normals, when there are any, keep unlike sides of thin parts apart, and become those of the fits.
 * info: or NULL. jobs: NULL: inline. About 60 us per noisy point.
 * SB_ERROR_ARGUMENT, _NOT_FINITE (error->node), _MEMORY: the cloud is untouched. */
REG_API sb_result reg_cloud_smooth(reg_cloud *cloud, const sb_jobs *jobs, reg_smooth_info *info, sb_error *error);
/* The same for the nodes of a surface, open or closed. Nodes whose shortest edge is 3 times as long as their
 * neighbours' are outliers, too; all of these are put amid their neighbours in the mesh, so that no holes come about.
 * Fails as reg_cloud_from_mesh does, too; the surface is then untouched. */
REG_API sb_result reg_cloud_smooth_mesh(sb_mesh *surface, const sb_jobs *jobs, reg_smooth_info *info, sb_error *error);

#if defined(REG_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
REGI_API sb_result regi_cloud_allocate(reg_cloud *cloud, int count, int with_normals, const sb_allocator *allocator,
                                       sb_error *error);
/* v / |v|, or 0. */
REGI_API sb_vec3 regi_cloud_unit(sb_vec3 v);
/* Normals of the nodes of a surface cut into triangles: the mean of those around, weighted by area; or 0. */
REGI_API void regi_cloud_face_normals(const sbi_surface_cut *cut, sb_vec3 *normals);
/* The value of rank `middle` among v[count], which is reordered. */
REGI_API sb_real regi_cloud_select(sb_real *v, int count, int middle);
/* At least one point, all finite; normals may be NULL. */
REGI_API sb_result regi_cloud_check(const sb_vec3 *points, const sb_vec3 *normals, int count, sb_error *error);
#endif

#endif /* REG_CLOUD_H */
