/* register.h 0.5.0: matching an organ model to what the surgeon sees
 * MIT or public domain, as you like; the texts are at the end of this file.
 * Generated from src/register/: edit there, then run `make headers`. */
#include "softbody.h"

/* ==== src/register/register_doc.h ==== */
/*
 * register.h - matching an organ model to what the surgeon sees, in one header on top of softbody.h.
 *
 * HOW TO INCLUDE
 *
 * In one C or C++ file, which is the one that holds softbody.h's implementation:
 *
 *     #define SB_IMPLEMENTATION
 *     #define REG_IMPLEMENTATION
 *     #include "register.h"
 *
 * and in all others only the last line; it includes softbody.h. Both headers come from one release and lie in one
 * folder. Link with -lm, optimise (-O2 or -O3).
 *
 * OPTIONS are softbody.h's. SB_REAL: exported names of a float build end in _f32. SB_STATIC, SB_SHARED and
 * SB_API hold for this header, too; REG_STATIC or REG_API for this one only.
 *
 * WHAT IT DOES NOT DO
 *
 * It finds no organ in a picture, and no landmark: it begins with points. A surface that slid along itself looks the
 * same; what the shape leaves open is decided by the elastic energy, or by landmarks.
 *
 * A FIRST PROGRAM
 *
 * An organ model is matched to a scan of an organ that was bent and moved: first rigidly, from any pose, then
 * elastically.
 *
 *     ```c
 *     #define SB_IMPLEMENTATION
 *     #define REG_IMPLEMENTATION
 *     #include "register.h"
 *     #include <stdio.h>
 *     #include <stdlib.h>
 *
 *     static void require(sb_result result, const sb_error *error)
 *     {
 *         if (result == SB_OK)
 *             return;
 *         fprintf(stderr, "%s\n", error->message);
 *         exit(1);
 *     }
 *
 *     int main(void)
 *     {
 *         sb_error error;
 *         sb_mesh organ;                                         // sb_mesh_load reads your own
 *         sb_boundary skin;                                      // its surface
 *         reg_cloud model, scan;                                 // points with normals; reg_cloud_load reads a file
 *         require(sb_mesh_organ(SB_TET4, 16, NULL, &organ, &error), &error);
 *         require(sb_mesh_boundary(&organ, 1, NULL, &skin, &error), &error);
 *         require(reg_cloud_from_mesh(&model, &skin.surface, NULL, &error), &error);
 *         for (int i = 0; i < skin.surface.node_count; i++) {       // here the scan is made: bent, turned and moved
 *             sb_vec3 *x = &skin.surface.nodes[i];
 *             *x = sb_v3(0.3 - x->y, x->x, x->z - 2 * x->x * x->x);
 *         }
 *         require(reg_cloud_from_mesh(&scan, &skin.surface, NULL, &error), &error);
 *
 *         reg_icp_shape from = {0}, to = {0};                    // rigid: no first guess is needed
 *         reg_icp_options options = reg_default_icp_options();
 *         reg_rigid motion;
 *         reg_icp_info rigid;
 *         from.points = model.points, from.normals = model.normals, from.count = model.count;
 *         to.points = scan.points, to.normals = scan.normals, to.count = scan.count;
 *         require(reg_icp(&from, &to, &options, &motion, &rigid, &error), &error);
 *
 *         sb_body *body = NULL;                                  // elastic: the organ, where the rigid motion puts it
 *         sb_body_def bd = sb_default_body_def();
 *         for (int i = 0; i < organ.node_count; i++)
 *             organ.nodes[i] = reg_rigid_apply(&motion, organ.nodes[i]);
 *         bd.mesh = &organ;
 *         bd.material = sb_material_corotated(5e3, 0.45, 1060);
 *         require(sb_body_create(&bd, &body, &error), &error);
 *         reg_match *match = NULL;
 *         reg_match_def md = reg_default_match_def();
 *         reg_match_info info;
 *         md.body = body;
 *         md.target = &skin.surface;
 *         require(reg_match_create(&md, &match, &error), &error);
 *         require(reg_match_run(match, 100, &info), &info.error);
 *         printf("rigid: %.1f mm left; elastic: %.2f mm after %d steps\n", 1e3 * rigid.mean, 1e3 * info.mean_distance,
 *                info.iterations);
 *         const sb_vec3 *moved = sb_body_positions(body);        // of all nodes, also inside: vessels, tumours
 *         printf("node 0 is at %.3f %.3f %.3f m\n", moved[0].x, moved[0].y, moved[0].z);
 *
 *         reg_match_destroy(match);
 *         sb_body_destroy(body);
 *         reg_cloud_free(&scan), reg_cloud_free(&model);
 *         sb_boundary_free(&skin), sb_mesh_free(&organ);
 *         return 0;
 *     }
 *     ```
 *
 * CONCEPTS
 *
 * Units are SI. Results, errors, memory, threads and determinism are as softbody.h says in its top comment.
 *
 * reg_cloud    points with or without normals, from PLY, XYZ and mesh files; normals by local fits, thinning, outliers;
 *              noise is taken off clouds and surfaces by reg_cloud_smooth and reg_cloud_smooth_mesh.
 * reg_kdtree   nearest points and those within a radius.
 * reg_rigid    a rotation and a translation; reg_rigid_fit gives the best one for pairs.
 * reg_icp      rigid registration of clouds and surfaces from any pose, also where only a part is seen; landmarks. Says
 *              which other poses fit, how clearly they are told apart, warnings by name, and a covariance.
 * reg_cpd_fit  coherent point drift, rigid to non-rigid, for clouds without a model (and markers of different number).
 * reg_field    the potential about a target: distance, or Laplace's.
 * reg_match    physics-based shape matching: an sb_body drawn to a target by charges on its surface.
 * reg_loads    what a match leaves open: the few loads on the surface, and the pose, that give the organ its shape.
 * reg_model    an organ as an inference knows it: mesh, surface, what holds it.
 * reg_infer    pose and shape from whatever part is seen, by loads that nobody knows, with the error to expect.
 * reg_track    follows an organ that moves, scan by scan, in milliseconds.
 * reg_nicp     non-rigid ICP: an sb_body drawn to pairs of points, also by what a camera sees.
 *
 * LICENCE
 *
 * MIT or public domain, as you like; the texts are at the end of this file.
 */

/* ==== src/register/../softbody/begin.h ==== */
/* begin: compiler settings for the library's own code; end.h gives the caller's back.
 *
 * A product and a sum may not be contracted into one rounding (fused multiply-add), or results would depend on the
 * compiler and the processor. Compilers differ in how a header can say so:
 * - clang: by the standard pragma; -ffp-contract=fast overrules it.
 * - gcc knows the standard pragma in no release yet, and contracts unless told -std=c99 or -ffp-contract=off. Its
 *   own pragma stops that, but code under it is not inlined into code outside, so it stands only where the target
 *   has fused instructions and the language mode lets gcc use them. The system headers come first: their inline
 *   functions are the caller's business.
 * - MSVC: by its own pragma, in the file that holds the implementation. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#if !defined(__STRICT_ANSI__) && (defined(__FP_FAST_FMA) || defined(__FP_FAST_FMAF))
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#if defined(SB_IMPLEMENTATION)
#include <errno.h>
#include <float.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#if defined(SB_USE_OPENMP) && defined(_OPENMP)
#include <omp.h>
#endif
#endif
#pragma GCC push_options
#pragma GCC optimize("fp-contract=off")
#endif
#elif defined(_MSC_VER) && defined(SB_IMPLEMENTATION)
#pragma fp_contract(off)
#endif

#ifndef REGISTER_H
#define REGISTER_H

/* ==== src/register/names.h ==== */
/* names: the exported names of a float build end in _f32, so that a float caller and a double object do
 * not link. Written by src/amalgamate.c from the declarations: do not edit. */
#ifndef REGI_NAMES_H
#define REGI_NAMES_H

#if defined(SB_REAL)
#define REGI_NAMES_PASTE_(a, b) a##b
#define REGI_NAMES_PASTE(a, b) REGI_NAMES_PASTE_(a, b)
#define REGI_NAMES_OF_double 0
#define REGI_NAMES_OF_float 1
#if REGI_NAMES_PASTE(REGI_NAMES_OF_, SB_REAL)
#define reg_rigid_identity reg_rigid_identity_f32
#define reg_rigid_apply reg_rigid_apply_f32
#define reg_rigid_compose reg_rigid_compose_f32
#define reg_rigid_inverse reg_rigid_inverse_f32
#define reg_rigid_angle reg_rigid_angle_f32
#define reg_rigid_fit reg_rigid_fit_f32
#define reg_kdtree_create reg_kdtree_create_f32
#define reg_kdtree_destroy reg_kdtree_destroy_f32
#define reg_kdtree_count reg_kdtree_count_f32
#define reg_kdtree_nearest reg_kdtree_nearest_f32
#define reg_kdtree_k_nearest reg_kdtree_k_nearest_f32
#define reg_kdtree_within reg_kdtree_within_f32
#define reg_cloud_free reg_cloud_free_f32
#define reg_cloud_from_points reg_cloud_from_points_f32
#define reg_cloud_from_mesh reg_cloud_from_mesh_f32
#define reg_cloud_load reg_cloud_load_f32
#define reg_cloud_load_memory reg_cloud_load_memory_f32
#define reg_cloud_save_ply reg_cloud_save_ply_f32
#define reg_cloud_estimate_normals reg_cloud_estimate_normals_f32
#define reg_cloud_thin reg_cloud_thin_f32
#define reg_cloud_spread reg_cloud_spread_f32
#define reg_outlier_limit reg_outlier_limit_f32
#define reg_cloud_remove_outliers reg_cloud_remove_outliers_f32
#define reg_cloud_smooth reg_cloud_smooth_f32
#define reg_cloud_smooth_mesh reg_cloud_smooth_mesh_f32
#define reg_default_field_def reg_default_field_def_f32
#define reg_field_create reg_field_create_f32
#define reg_field_destroy reg_field_destroy_f32
#define reg_field_closest reg_field_closest_f32
#define reg_field_along reg_field_along_f32
#define reg_field_at reg_field_at_f32
#define reg_field_bounds reg_field_bounds_f32
#define reg_field_sweeps reg_field_sweeps_f32
#define reg_default_icp_options reg_default_icp_options_f32
#define reg_icp_stop_string reg_icp_stop_string_f32
#define reg_warning_string reg_warning_string_f32
#define reg_icp reg_icp_f32
#define reg_default_cpd_options reg_default_cpd_options_f32
#define reg_cpd_fit reg_cpd_fit_f32
#define reg_cpd_destroy reg_cpd_destroy_f32
#define reg_cpd_get_info reg_cpd_get_info_f32
#define reg_cpd_moved reg_cpd_moved_f32
#define reg_cpd_partners reg_cpd_partners_f32
#define reg_cpd_probabilities reg_cpd_probabilities_f32
#define reg_cpd_linear reg_cpd_linear_f32
#define reg_cpd_apply reg_cpd_apply_f32
#define reg_default_match_def reg_default_match_def_f32
#define reg_match_create reg_match_create_f32
#define reg_match_destroy reg_match_destroy_f32
#define reg_match_step reg_match_step_f32
#define reg_match_run reg_match_run_f32
#define reg_match_restart reg_match_restart_f32
#define reg_match_move_landmarks reg_match_move_landmarks_f32
#define reg_match_landmarks reg_match_landmarks_f32
#define reg_match_body reg_match_body_f32
#define reg_match_get_info reg_match_get_info_f32
#define reg_match_sample_count reg_match_sample_count_f32
#define reg_match_get_sample reg_match_get_sample_f32
#define reg_default_nicp_def reg_default_nicp_def_f32
#define reg_nicp_create reg_nicp_create_f32
#define reg_nicp_destroy reg_nicp_destroy_f32
#define reg_nicp_step reg_nicp_step_f32
#define reg_nicp_run reg_nicp_run_f32
#define reg_nicp_restart reg_nicp_restart_f32
#define reg_nicp_move_landmarks reg_nicp_move_landmarks_f32
#define reg_nicp_landmarks reg_nicp_landmarks_f32
#define reg_nicp_body reg_nicp_body_f32
#define reg_nicp_get_info reg_nicp_get_info_f32
#define reg_nicp_surface_count reg_nicp_surface_count_f32
#define reg_nicp_positions reg_nicp_positions_f32
#define reg_nicp_source_count reg_nicp_source_count_f32
#define reg_nicp_get_source reg_nicp_get_source_f32
#define reg_default_loads_def reg_default_loads_def_f32
#define reg_loads_run reg_loads_run_f32
#define reg_default_model_def reg_default_model_def_f32
#define reg_model_create reg_model_create_f32
#define reg_model_destroy reg_model_destroy_f32
#define reg_model_node_count reg_model_node_count_f32
#define reg_default_infer_def reg_default_infer_def_f32
#define reg_infer_run reg_infer_run_f32
#define reg_infer_destroy reg_infer_destroy_f32
#define reg_infer_displacements reg_infer_displacements_f32
#define reg_infer_forces reg_infer_forces_f32
#define reg_infer_expected reg_infer_expected_f32
#define reg_infer_draw reg_infer_draw_f32
#define reg_infer_covariance reg_infer_covariance_f32
#define reg_infer_best_landmark reg_infer_best_landmark_f32
#define reg_infer_get_quality reg_infer_get_quality_f32
#define reg_prior_string reg_prior_string_f32
#define reg_infer_stop_string reg_infer_stop_string_f32
#define reg_default_track_def reg_default_track_def_f32
#define reg_track_create reg_track_create_f32
#define reg_track_destroy reg_track_destroy_f32
#define reg_track_restart reg_track_restart_f32
#define reg_track_set_target reg_track_set_target_f32
#define reg_track_set_features reg_track_set_features_f32
#define reg_track_step reg_track_step_f32
#define reg_track_displacements reg_track_displacements_f32
#define reg_track_covariances reg_track_covariances_f32
#define reg_track_save_size reg_track_save_size_f32
#define reg_track_save reg_track_save_f32
#define reg_track_load reg_track_load_f32
#define reg_track_state_string reg_track_state_string_f32
#endif
#endif

#endif /* REGI_NAMES_H */

/* ==== src/register/api.h ==== */
/* api: version and linkage of register.h. Results, errors, allocator, vectors and the scalar type are softbody.h's. */
#ifndef REG_API_H
#define REG_API_H


#define REG_VERSION_MAJOR 0
#define REG_VERSION_MINOR 5
#define REG_VERSION_PATCH 0
#define REG_VERSION_STRING "0.5.0"

#if REG_VERSION_MAJOR != SB_VERSION_MAJOR || REG_VERSION_MINOR != SB_VERSION_MINOR ||                                  \
    REG_VERSION_PATCH != SB_VERSION_PATCH
#error "register.h and softbody.h are of different versions: take both from one release"
#endif
#if defined(SB_NO_GEOMETRY) || defined(SB_NO_FILES)
#error "register.h needs the surfaces and file readers of softbody.h: leave SB_NO_GEOMETRY and SB_NO_FILES undefined"
#endif
#if defined(REG_IMPLEMENTATION) && !defined(SB_IMPLEMENTATION)
#error "register.h: define REG_IMPLEMENTATION in the file that defines SB_IMPLEMENTATION"
#endif

/* REG_API: what stands before each public function: static under SB_STATIC or REG_STATIC; exported or imported under
 * SB_SHARED, as REG_IMPLEMENTATION says; your own where you define it, or SB_API, before including. REGI_API: internal
 * functions; static in the shipped header, extern when the rooms are compiled apart. */
#if defined(REG_API)
/* the caller's */
#elif defined(SB_STATIC) || defined(REG_STATIC)
#define REG_API static SBI_UNUSED
#elif defined(SBI_API_IS_GIVEN)
#define REG_API SB_API
#elif defined(SB_SHARED) && defined(REG_IMPLEMENTATION)
#define REG_API SBI_EXPORT
#elif defined(SB_SHARED)
#define REG_API SBI_IMPORT
#else
#define REG_API SBI_EXTERN
#endif
#if defined(SB_SPLIT_BUILD)
#define REGI_API extern
#else
#define REGI_API static SBI_UNUSED
#endif

#endif /* REG_API_H */

/* ==== src/register/rigid.h ==== */
/* rigid: rigid motions, and the one that brings points nearest to their partners. Floor 6. */
#ifndef REG_RIGID_H
#define REG_RIGID_H


/* x -> rotation x + translation. */
typedef struct reg_rigid {
    sb_mat3 rotation;    /* orthonormal, determinant 1 */
    sb_vec3 translation; /* m */
} reg_rigid;

REG_API reg_rigid reg_rigid_identity(void);
REG_API sb_vec3 reg_rigid_apply(const reg_rigid *motion, sb_vec3 point);
/* First `first`, then `then`. */
REG_API reg_rigid reg_rigid_compose(const reg_rigid *then, const reg_rigid *first);
REG_API reg_rigid reg_rigid_inverse(const reg_rigid *motion);
/* Angle (rad, in [0, pi]) of the rotation. */
REG_API sb_real reg_rigid_angle(const reg_rigid *motion);

/* The motion that minimises sum w |motion(from) - to|^2 (Kabsch 1976, never a reflection).
 * from, to: [count] partners (m); weights: [count] >= 0, not all 0, or NULL: all 1; count >= 1. Where the points leave
 * the rotation open (all in one line or one point) it is one of the best. SB_ERROR_ARGUMENT, _NOT_FINITE (index named)
 * leave *motion untouched. No allocation. */
REG_API sb_result reg_rigid_fit(const sb_vec3 *from, const sb_vec3 *to, const sb_real *weights, int count,
                                reg_rigid *motion, sb_error *error);

#endif /* REG_RIGID_H */

/* ==== src/register/kdtree.h ==== */
/* kdtree: nearest points of a cloud. Floor 6.
 *
 * A balanced tree over a copy of the points, eight to a leaf and side by side there; every node knows the smallest
 * boxes around its halves. Queries allocate and change nothing, so any number of threads may ask at once, and give the
 * same answer whatever the tree looks like: of points equally far, the one with the smallest index counts as nearer. */
#ifndef REG_KDTREE_H
#define REG_KDTREE_H


typedef struct reg_kdtree reg_kdtree;

/* Makes a tree of points[count] (m; count >= 1, points may coincide), which are copied. One block of memory from
 * `allocator` (NULL: malloc; at most 80 bytes per point) and scratch that goes back.
 * O(count log count). SB_ERROR_ARGUMENT (null pointer, no points, or a coordinate whose square would overflow),
 * _NOT_FINITE (error->node: the point), _MEMORY; then *tree is untouched. */
REG_API sb_result reg_kdtree_create(const sb_vec3 *points, int count, const sb_allocator *allocator, reg_kdtree **tree,
                                    sb_error *error);
REG_API void reg_kdtree_destroy(reg_kdtree *tree); /* accepts NULL */
/* Number of its points; 0 for NULL. */
REG_API int reg_kdtree_count(const reg_kdtree *tree);

/* Index of the point nearest to `point` among those at most `within` (m; SB_REAL_MAX: any) away, and its squared
 * distance (m^2) in *squared (may be NULL). -1 (nothing written) when there is none, the tree is NULL, or an argument
 * is not finite or negative. O(log count) for points near the cloud. */
REG_API int reg_kdtree_nearest(const reg_kdtree *tree, sb_vec3 point, sb_real within, sb_real *squared);

/* The k nearest points, nearest first: indices[k] and squared distances squared[k] (m^2; both needed). Returns how many
 * were found: k, or all points when there are fewer; 0 for k < 1, NULL, or a point that is not finite. */
REG_API int reg_kdtree_k_nearest(const reg_kdtree *tree, sb_vec3 point, int k, int *indices, sb_real *squared);

/* All points at most `radius` (m) away: returns how many, of which the first `room` are written to indices[room] (may
 * be NULL with room 0: only count). In no particular, yet always the same order. 0 as above. */
REG_API int reg_kdtree_within(const reg_kdtree *tree, sb_vec3 point, sb_real radius, int *indices, int room);


#endif /* REG_KDTREE_H */

/* ==== src/register/cloud.h ==== */
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


#endif /* REG_CLOUD_H */

/* ==== src/register/field.h ==== */
/* field: the potential about a target that matching slides down: its distance, or Laplace's. Floor 6. */
#ifndef REG_FIELD_H
#define REG_FIELD_H


typedef enum reg_field_kind {
    REG_FIELD_DISTANCE = 0, /* phi: distance to the target (m); exact everywhere, nothing is computed beforehand */
    REG_FIELD_LAPLACE = 1   /* Lap phi = 0 in a box, phi = 0 on the target and the distance on the box: the field of a
                             * charged conductor. Inside a closed target it is 0 */
} reg_field_kind;

/* What a field is made from; start from reg_default_field_def(). The target is a surface or a cloud. */
typedef struct reg_field_def {
    reg_field_kind kind;    /* default REG_FIELD_DISTANCE */
    const sb_mesh *surface; /* triangles or quads, open or closed, or NULL. Read at creation only, as are all below */
    const sb_vec3 *points;  /* [point_count] a cloud (m), or NULL */
    const sb_vec3 *normals; /* [point_count] outward, of any length, 0: unknown; or NULL: none are known */
    int point_count;
    sb_vec3 low, high;      /* Laplace: the box (m); it is enlarged to leave a tenth of the target's size around the
                             * target. Equal corners (default): that */
    int cells;              /* Laplace: grid cells along the longest side of the box, in [8, 256]; default 64, which
                             * takes some 0.3 s */
    sb_allocator allocator; /* zeros: malloc */
    sb_jobs jobs;           /* threads for the creation; zeros: none */
    unsigned cookie;        /* set by reg_default_field_def */
} reg_field_def;
REG_API reg_field_def reg_default_field_def(void);

typedef struct reg_field reg_field;

/* SB_ERROR_ARGUMENT (no target or two, a field out of range), SB_ERROR_NOT_FINITE (error->node: the point, or the
 * normal), what sb_surface_create says of the surface, SB_ERROR_MEMORY; *field is then untouched. Everything is copied.
 * Queries allocate nothing and may come from any number of threads. Release with reg_field_destroy. */
REG_API sb_result reg_field_create(const reg_field_def *def, reg_field **field, sb_error *error);
REG_API void reg_field_destroy(reg_field *field); /* NULL is fine */

/* The place of the target closest to a point. */
typedef struct reg_field_hit {
    sb_vec3 point;    /* m */
    sb_vec3 normal;   /* of the target there, unit length; 0 where none is known */
    sb_real distance; /* m */
    int item;         /* triangle (of the surface cut into triangles), or point of the cloud */
    int on_border;    /* 1: on the rim of an open target, beyond which nothing was seen */
} reg_field_hit;
/* 1 and *hit; 0 for a point that is not finite or absurdly far away (*hit untouched). guess: the item of a query
 * nearby, or -1; it changes the time, not the answer. About 1 us with a good guess. */
REG_API int reg_field_closest(const reg_field *field, sb_vec3 point, int guess, reg_field_hit *hit);

/* The potential on a line through a point. */
typedef struct reg_field_sample {
    sb_real phi;    /* m */
    sb_real phi_n;  /* slope along the direction over the length `step` */
    sb_real phi_nn; /* derivative of phi_n along the direction (1/m); of either sign */
} reg_field_sample;
/* Samples the potential at point (m) along the unit vector direction:
 *     phi_n = [phi(s + h n/2) - phi(s - h n/2)] / h,  phi_nn = d phi_n / ds
 * with h = step (m, > 0), which rounds the potential's kink on the target off. phi_nn is the exact derivative of this
 * phi_n, from the slopes at its two ends, not a difference of its own: Newton's method then converges as it should.
 * Laplace's phi outside its box is that of the nearest point of the box. Returns 0 as above.
 * Source: Suwelack 2014, (7.3), (7.15). */
REG_API int reg_field_along(const reg_field *field, sb_vec3 point, sb_vec3 direction, sb_real step, int guess,
                            reg_field_sample *sample);
/* phi (m) at a point, and its gradient unless NULL: away from the closest point, or of the trilinear interpolation. On
 * the target itself, where the distance has none, it is 0. Returns 0 as above. */
REG_API int reg_field_at(const reg_field *field, sb_vec3 point, int guess, sb_real *phi, sb_vec3 *gradient);

/* Smallest box around the target (m). */
REG_API void reg_field_bounds(const reg_field *field, sb_vec3 *low, sb_vec3 *high);
/* Laplace: sweeps that its solution took; 0 for distances. */
REG_API int reg_field_sweeps(const reg_field *field);


#endif /* REG_FIELD_H */

/* ==== src/register/icp.h ==== */
/* icp: rigid alignment of an organ model with what is seen of it, from any pose. Floor 6.
 *
 *     reg_icp_shape model = {0}, target = {0};       (points and count; best with normals, or a surface)
 *     reg_icp_options options = reg_default_icp_options();
 *     options.overlap = REG_ICP_TARGET_PART;         (the target is a part of the model's surface)
 *     result = reg_icp(&model, &target, &options, &motion, &info, &error);     (target ~ motion(model))
 *
 * Iterative closest points (Besl, McKay 1992; to planes: Chen, Medioni 1992): pair every point with the closest one of
 * the other shape, leave out outliers, move, again. That finds the nearest minimum only, so a start is searched first:
 * many rotations, few points, few rounds; the best ones get more of both.
 *
 * The same bits for any thread and compiler; only a time limit makes a result depend on the machine. */
#ifndef REG_ICP_H
#define REG_ICP_H


/* One of the two shapes. Everything is borrowed during the call. Zero-initialise. Points in one place count once. */
typedef struct reg_icp_shape {
    const sb_vec3 *points; /* [count], m; also of a surface: its nodes, or samples of it */
    int count;
    const sb_vec3 *normals;    /* [count], outward, or NULL: taken from the surface, else fitted to the points */
    const sb_real *weights;    /* [count] >= 0, how much a point counts (patches that are known well); NULL: all 1 */
    const sb_real *sd;         /* [count] > 0, m, how sure a point is: counts as a weight of 1 / sd^2; NULL: alike */
    const sb_surface *surface; /* closest points are looked for on this surface; NULL: among the points */
    const reg_kdtree *tree;    /* of the points; NULL: one is made */
    int has_camera;            /* 1: this is a view, from `camera`: normals face it, and nothing is in front of it */
    sb_vec3 camera;            /* m, in this shape's frame */
} reg_icp_shape;

typedef enum reg_icp_metric {
    REG_ICP_POINT = 0, /* distance to the closest point */
    REG_ICP_PLANE = 1  /* distance to the plane through it: fewer rounds, slides along flat parts */
} reg_icp_metric;

typedef enum reg_icp_overlap {
    REG_ICP_WHOLE = 0,       /* both show the whole organ: each looks for the other */
    REG_ICP_TARGET_PART = 1, /* the target is a part of the model's surface: only its points look */
    REG_ICP_MODEL_PART = 2   /* the model is a part of the target's surface: only its points look */
} reg_icp_overlap;

/* A point of the model and where it is seen. */
typedef struct reg_icp_landmark {
    sb_vec3 model, target; /* m */
    sb_real weight;        /* > 0: as a share of all pairs of the surfaces together; 0.1: a tenth of them */
} reg_icp_landmark;

/* Start from reg_default_icp_options(). */
typedef struct reg_icp_options {
    reg_icp_overlap overlap;           /* WHOLE */
    reg_icp_metric metric;             /* PLANE */
    int search;                        /* 1: look for the start among all rotations; 0: begin at `start`; 1 */
    reg_rigid start;                   /* model to target; identity. With search it is one candidate among the others */
    sb_real start_shift_sd;            /* m, and */
    sb_real start_turn_sd;             /* rad: how sure that start is; both > 0 count in the choice; 0: not at all; 0 */
    sb_vec3 seen_from;                 /* from the organ to the camera, in the model's frame, any length; 0 */
    sb_real seen_from_sd;              /* rad, how sure that is; 0: not known; 0 */
    const reg_icp_landmark *landmarks; /* [landmark_count] or NULL */
    int landmark_count;
    reg_outliers outliers;     /* pairs that do not count, by their distance, see reg_outlier_limit; MEDIAN */
    sb_real outlier_parameter; /* 3 */
    sb_real max_distance;      /* m, > 0: pairs farther apart never count; SB_REAL_MAX */
    int sample;                /* points of a shape that look for partners, evenly spread; 0: all; 2000 */
    int max_iterations;        /* >= 1, of the last stage; 100 */
    sb_real tolerance;         /* >= 0: ends when the mean distance changes by less than this share; 1e-6 */
    sb_clock clock;            /* NULL: no time limit */
    double max_seconds;        /* > 0; 10. Looked at between rounds; what comes before them is linear in the points */
    sb_allocator allocator;    /* zeros: malloc */
    int cookie;                /* set by reg_default_icp_options */
} reg_icp_options;

typedef enum reg_icp_stop {
    REG_ICP_CONVERGED = 0,
    REG_ICP_ITERATIONS = 1, /* max_iterations */
    REG_ICP_TIME = 2        /* max_seconds */
} reg_icp_stop;

/* What to know before an alignment is used. */
typedef enum reg_warning {
    REG_WARN_AMBIGUOUS = 1, /* another pose is nearly as likely: info.poses[1] */
    /* of an inference, which has VIEW_SMALL, MANY_OUTLIERS and LOW_CONTRAST, too: */
    REG_WARN_STRAIN = 256,       /* an element has a principal stretch that differs from 1 by more than 0.3 */
    REG_WARN_VOLUME = 512,       /* the organ's volume changed by more than 0.1 */
    REG_WARN_NOT_AT_REST = 1024, /* the last round moved a node farther than the error to expect */
    REG_WARN_INVERTED = 2,       /* normals pointed inwards and were taken the other way round */
    REG_WARN_MIXED_NORMALS = 4,  /* normals pointed towards the camera and away from it: they were fitted anew */
    REG_WARN_SCALE = 8,          /* the sizes do not fit: info.scale_guess */
    REG_WARN_VIEW_SMALL = 16,    /* the target shows less than 15 % of the model */
    REG_WARN_MANY_OUTLIERS = 32, /* over 30 % of the points that looked found nothing of the other shape */
    REG_WARN_LOW_CONTRAST = 64,  /* the shapes leave a motion open, as a sphere's turns: info.covariance */
    REG_WARN_FREE_SPACE = 128    /* over 10 % of what the camera faced would hide what it saw */
} reg_warning;

enum { REG_ICP_POSES = 8 };

typedef struct reg_icp_info {
    reg_icp_stop stop;
    int iterations;       /* of the last stage */
    int candidates;       /* poses that the search tried */
    int pairs;            /* that counted at the end, without landmarks */
    sb_real overlap;      /* their share of all points that looked */
    sb_real mean, rms;    /* m, distance between the partners that counted */
    sb_real landmark_rms; /* m, weighted; 0 without landmarks */
    double seconds;       /* 0 without a clock */
    unsigned warnings;    /* REG_WARN_..., or-ed */
    /* distinct poses, model to target, the likeliest first; the first is the result, those 3 nats behind are less
     * refined */
    int pose_count;
    reg_rigid poses[REG_ICP_POSES];
    sb_real likelihood[REG_ICP_POSES]; /* nats against the first (0): for so many independent patches as the target is
                                        * large, its noise the best pose's */
    sb_real margin;                    /* nats between the first two; SB_REAL_MAX: there is one only */
    sb_real noise;                     /* m: deviation of the target from the model, noise and deformation, robust */
    sb_real seen;                      /* area of the target as a share of the model's, estimated */
    sb_real scale_guess;               /* what the target's lengths should be multiplied with; 1: nothing to say */
    /* Covariance [6][6] of the result: turn (rad) about `centre` and shift (m), in the target's frame, for independent
     * errors of the points of deviation `noise`: s^2 (A^T A)^-1 with the rows (c x n, n) of A. */
    sb_real covariance[36];
    sb_vec3 centre; /* m */
} reg_icp_info;

REG_API reg_icp_options reg_default_icp_options(void);
/* "converged", "iterations", "time"; static. */
REG_API const char *reg_icp_stop_string(reg_icp_stop stop);

/* "ambiguous", "inverted normals", ...: of one warning; static. "unknown" else. */
REG_API const char *reg_warning_string(reg_warning warning);

/* The motion that brings the model to the target.
 *
 * options  NULL: reg_default_icp_options()
 * motion   written on success, also when a cap ended the run; info (or NULL) too
 * SB_ERROR_ARGUMENT (what is said above; weights all 0), _NOT_FINITE (error->node: the point), _MEMORY,
 * _NOT_CONVERGED (no pair within max_distance): outputs untouched.
 *
 * About 0.1 s for surfaces of 6,000 points with search, 0.02 s without. Points that lie in a line, a plane or one place
 * leave motions open; it then takes one of the best. */
REG_API sb_result reg_icp(const reg_icp_shape *model, const reg_icp_shape *target, const reg_icp_options *options,
                          reg_rigid *motion, reg_icp_info *info, sb_error *error);

#endif /* REG_ICP_H */

/* ==== src/register/cpd.h ==== */
/* cpd: coherent point drift, which moves one point cloud onto another without knowing pairs. Floor 6.
 *
 *     reg_cpd_options options = reg_default_cpd_options();
 *     reg_cpd *fit = NULL;
 *     if (reg_cpd_fit(source, source_count, target, target_count, &options, &fit, &error) != SB_OK) ...
 *     reg_cpd_apply(fit, mesh.nodes, mesh.node_count, moved);      (whatever shall follow)
 *     reg_cpd_destroy(fit);
 *
 * The target's points are taken for draws from Gaussians of one width sigma around the moved source points, mixed with
 * a uniform share of outliers; expectation-maximisation lowers the negative log-likelihood of that, which never rises
 * (Myronenko and Song 2010). The clouds may differ in size. Each is first brought to mean 0 and root mean square
 * distance 1 from it, where beta, lambda and sigma^2 of the paper are at home; results are in the caller's units.
 * All is computed in double, in a float build, too: sigma^2 falls below what float resolves.
 *
 * The Gram matrix of the Gaussian kernel is factored once, G = L L^T by Cholesky with the largest remaining diagonal
 * entry as pivot, until none is above kernel_tolerance. That entry bounds every entry of G - L L^T; eigenpairs would do
 * with fewer columns, but cost more to find, and the deformation at other points would need all source points: so it
 * needs the pivots only. The rest is exact coherent point drift with the kernel L L^T. */
#ifndef REG_CPD_H
#define REG_CPD_H


typedef enum reg_cpd_kind {
    REG_CPD_RIGID = 0,      /* rotation, translation */
    REG_CPD_SIMILARITY = 1, /* rotation, translation, scale */
    REG_CPD_AFFINE = 2,
    REG_CPD_NONRIGID = 3 /* y + sum_k exp(-|y - c_k|^2 / 2 beta^2) w_k */
} reg_cpd_kind;

typedef enum reg_cpd_stop {
    REG_CPD_CONVERGED = 0,  /* the objective fell by no more than the tolerance */
    REG_CPD_EXACT = 1,      /* the clouds lie on each other: sigma fell to 1e-5 of the target's size */
    REG_CPD_ITERATIONS = 2, /* cap */
    REG_CPD_TIME = 3        /* cap */
} reg_cpd_stop;

/* How far a fit is, and how it ended. */
typedef struct reg_cpd_info {
    int iterations; /* updates of the motion */
    int rank;       /* columns of the kernel's factor; 0 unless non-rigid */
    reg_cpd_stop stop;
    sb_real sigma;         /* m: distance, per coordinate, that is left between partners */
    sb_real explained;     /* expected number of target points that are no outliers */
    sb_real change;        /* fall of the objective in the last iteration, per target point */
    double objective;      /* negative log-likelihood (clouds of rms 1) + lambda/2 |L^T W|^2 + landmarks */
    double pairs;          /* pairs of points that were summed, all iterations together */
    double seconds;        /* with a clock, otherwise 0 */
    double kernel_seconds; /* of these for factoring the kernel */
} reg_cpd_info;

/* How to fit. Start from reg_default_cpd_options(). */
typedef struct reg_cpd_options {
    reg_cpd_kind kind;        /* default non-rigid */
    sb_real outliers;         /* w: expected share of target points without partner, in [0, 1); default 0.1 */
    sb_real beta;             /* width of the kernel over the source's rms size, in [1e-6, 1e6]; default 2, the paper's:
                               * smaller is less stiff */
    sb_real lambda;           /* price of deformation, in [1e-12, 1e12]; default 3, the paper's. For organs of a few
                               * thousand points beta 0.7 and lambda 1000 did best */
    int shared_frame;         /* 1: both clouds are measured by the source's mean and size, which keeps a rough
                               * alignment as start (take it for partial clouds). 0 (default): each by its own; kind
                               * rigid takes the source's size for both in any case */
    sb_real start_sigma;      /* m; 0 (default): from the mean squared distance of all pairs. That lets a soft source
                               * collapse and unfold another way round: after a rough alignment take what it left */
    sb_real kernel_tolerance; /* in (1e-12, 1); default 1e-4 */
    int max_rank;             /* columns of the kernel's factor at most; default 1000. With a smaller number than the
                               * tolerance needs, deformation is made of the smoothest modes */
    sb_real sum_tolerance;    /* share of each target point's probability that sums may leave out, in [0, 0.1]; 0: none
                               * is. Default 1e-5 */
    sb_real tolerance;        /* >= 0: ends when an iteration lowers the objective per target point by no more; 1e-6 */
    int max_iterations;       /* >= 0; default 300; 0 only pairs */
    double max_seconds;       /* looked at after each iteration; 0 (default): no cap; needs the clock */
    double max_pairs;         /* source points times target points; larger clouds are refused: thin them. 4e8 */

    int landmark_count;              /* known partners, >= 0 */
    const int *landmark_points;      /* [landmark_count] of the source; borrowed during the call */
    const sb_vec3 *landmark_targets; /* [landmark_count] m, where they are seen */
    sb_real landmark_sigma;          /* m, > 0: how sure that is */

    int (*progress)(void *user, const reg_cpd_info *info); /* after each iteration, by the caller's thread; a result
                                                            * other than 0 cancels. Default NULL */
    void *progress_user;
    sb_clock clock;         /* default NULL */
    sb_allocator allocator; /* default malloc */
    sb_jobs jobs;           /* default inline; any gives the same bits */
    unsigned cookie;        /* set by reg_default_cpd_options; options made without it are refused */
} reg_cpd_options;

REG_API reg_cpd_options reg_default_cpd_options(void);

/* What was fitted. */
typedef struct reg_cpd reg_cpd;

/* Moves source onto target.
 * source, target  [count] (m), at least one point each, in any order; copied
 * options         NULL: defaults
 * fit             made on success; the caller's, for reg_cpd_destroy; untouched otherwise
 * A cap that was reached is no error: info.stop reports it, and the fit is as good as it got.
 * Cost of an iteration: at most source_count target_count exponentials (about 5 ns each), and as sigma shrinks those of
 * near blocks of points only; non-rigid in addition source_count rank^2 / 2 + rank^3 / 6 multiply-adds. Memory: rank
 * (source_count + rank) doubles. The same bits for any jobs.
 * SB_ERROR_ARGUMENT (also a landmark of no point: error->node is its index), _NOT_FINITE (error->node; the message
 * names the cloud; also where a fit goes beyond what sb_real holds), _UNSUPPORTED (more than max_pairs), _CANCELLED,
 * _NOT_CONVERGED (no target point is near enough any source point to be more than an outlier), _MEMORY. */
REG_API sb_result reg_cpd_fit(const sb_vec3 *source, int source_count, const sb_vec3 *target, int target_count,
                              const reg_cpd_options *options, reg_cpd **fit, sb_error *error);
REG_API void reg_cpd_destroy(reg_cpd *fit); /* NULL is fine */

REG_API reg_cpd_info reg_cpd_get_info(const reg_cpd *fit);
/* The source where it was moved to: [source_count] (m), in its order; the fit's. */
REG_API const sb_vec3 *reg_cpd_moved(const reg_cpd *fit);
/* For each source point the target point that is most probably its partner, -1 where all probabilities are 0; the
 * fit's. Several source points may name one target point: compare probabilities. */
REG_API const int *reg_cpd_partners(const reg_cpd *fit);
/* [source_count] the probability of that: that the target point was drawn from this source point. */
REG_API const sb_real *reg_cpd_probabilities(const reg_cpd *fit);
/* x -> linear x + translation (m) of kinds rigid, similarity and affine; of non-rigid what the frames of the clouds
 * make of a point far from the source. */
REG_API void reg_cpd_linear(const reg_cpd *fit, sb_mat3 *linear, sb_vec3 *translation);
/* moved[count]: where the points (m) go; in place is fine. `rank` exponentials for each point. Nothing happens for
 * NULL. Points that are not finite give NaN. Thread-safe. */
REG_API void reg_cpd_apply(const reg_cpd *fit, const sb_vec3 *points, int count, sb_vec3 *moved);

#endif /* REG_CPD_H */

/* ==== src/register/match.h ==== */
/* match: physics-based shape matching: an elastic organ whose charged surface is drawn onto a target. Floor 6.
 *
 * The organ is a body of any mesh and material (corotated; linear is the thesis' other variant). Its surface carries
 * charges, one in each triangle or at each vertex, held by the element they lie in. The surface may be the model's own
 * skin or, better, the fine surface that the coarse model was made from: then that surface is matched, not the coarse
 * model's facets. In the potential phi of the target (see field.h) a charge q A feels the force -q A grad phi, whose
 * stiffness along its line of action is taken into the system:
 *     (K + K_phi) du = -(f_int + f_phi),     f_phi = q A N_I phi' m,    K_phi = q A N_I N_J phi'' m m^T
 * One step solves this once and then raises the charge by the ratio of elastic to electric energy, held within bounds:
 * q grows from a gentle pull, by which the organ finds its way, to a firm one, by which it fits. Steps at full charge
 * are relaxed (Aitken), or charges that rest on edges between the target's facets would swing to and fro for ever.
 *
 * Steps are quasi-static. K_phi and the slow growth of the charge give the stability that the thesis gets from Newmark
 * dynamics: with its stiffness damping the same number of steps led to the same end.
 *
 * What it cannot know: a surface that slides along itself keeps its shape. What loads normal to the surface did comes
 * out to a few hundredths of the motion or much better, from a part of the surface too; but where the organ was dragged
 * along its surface the motion found is the one of least energy, which may be off by the length of the drag. Landmarks
 * mend that, and so does what is known of loads (see loads.h).
 *
 * Sources: Suwelack 2014, chapter 7, with corrected factors: no 1/2 in f_phi and K_phi, and bounds on the growth of the
 * charge (q I_int / I_phi alone has an unstable fixed point). */
#ifndef REG_MATCH_H
#define REG_MATCH_H


typedef enum reg_match_method {
    REG_PBSM = 0,        /* the potential is the distance: default */
    REG_PBSM_LAPLACE = 1 /* Laplace's potential on a grid, computed once at creation */
} reg_match_method;

/* Why a match is as far as it is. */
typedef enum reg_match_stop {
    REG_MATCH_RUNNING = 0,    /* more steps would help */
    REG_MATCH_SETTLED = 1,    /* full charge, and the mean distance no longer falls */
    REG_MATCH_STEP_CAP = 2,   /* the steps asked for are done */
    REG_MATCH_TIME_CAP = 3,   /* def.max_seconds are over */
    REG_MATCH_NO_OVERLAP = 4, /* less than def.least_active of the surface is near the target: nothing was moved */
    REG_MATCH_FAILED = 5      /* a step failed and was undone: info.error */
} reg_match_stop;

/* What a match is made from. Start from reg_default_match_def(), set body and a target. Lengths are shares of the
 * organ's size: the diagonal of its bounding box. */
typedef struct reg_match_def {
    sb_body *body;          /* volume mesh at rest or deformed; borrowed: the match moves it, and it must outlive the
                             * match. Supports hold their nodes where they are to be (sb_body_fix_nodes for regions
                             * known not to move); dead loads, springs and mappings act; constraints are refused.
                             * Gravity acts too: leave it 0 when the rest shape already hangs in it */
    const sb_mesh *surface; /* surface of the organ at rest, tri or quad, outward, or NULL (default): the boundary of
                             * the body; of one that an sb_cut has cut that of the mesh before, without lips and walls
                             * of holes. What was taken out of it does not count. Read at creation only */
    const sb_mesh *target;  /* surface that was seen, outward, in the same frame; or NULL, then: */
    const sb_vec3 *target_points;  /* [target_count] cloud (m) */
    const sb_vec3 *target_normals; /* [target_count] outward, or NULL */
    int target_count;
    reg_match_method method;
    int cells;   /* Laplace: of the grid along the longest side, [8, 256]; default 64 */
    int partial; /* 1: the target is a part of the surface: charges act by distance and normal. 0: all act.
                  * SB_AUTO (default): 1 for open surfaces and for clouds */
    sb_real reach, last_reach; /* partial: a charge acts within `reach`, which shrinks by 7 % a step to `last_reach`;
                                * both > 0; default 0.1, 0.02 */
    sb_real least_cosine;      /* partial: and where its normal and the target's have at least this cosine, [-1, 1];
                                * default 0.5 */
    sb_real least_active;      /* partial: least share of the surface's area that must act, [0, 1]; default 0.1. With
                                * landmarks it is not asked for */
    sb_real sampling;          /* half of it to each side of the target is where the potential is rounded off, > 0;
                                * default 0.015. The pull of a charge is full beyond and falls to 0 on the target */
    sb_real first_charge;      /* charge per area to begin with, in Young's moduli, > 0; default 0.2: finds the balance
                                * of loads normal to the surface. 7 takes half the steps and holds on to what is near
                                * from the beginning: better by a quarter where the surface was dragged along itself */
    sb_real last_charge;       /* and most of it, >= first_charge; default 100: the shape counts, the energy
                                * decides what it leaves open. Less follows noise less */
    sb_real least_growth, most_growth; /* of the charge in a step, 1 < least <= most; default 1.15, 2 */
    const sb_vec3 *landmarks;          /* [landmark_count] points on or in the organ at rest (m), or NULL */
    const sb_vec3 *landmark_targets;   /* [landmark_count] where they are seen (m) */
    int landmark_count;
    sb_real landmark_stiffness; /* of each one's spring, in Young's modulus times mean element size, > 0; default 50 */
    sb_real settled;            /* the mean distance has settled when it falls by less than this share three steps
                                 * running, > 0; default 0.005 */
    double max_seconds;         /* most time of all steps together, > 0; needs `clock`; default 1e9 */
    sb_clock clock;             /* default NULL: times read 0 */
    sb_allocator allocator;     /* default malloc; the threads are the body's */
    unsigned cookie;            /* set by reg_default_match_def */
} reg_match_def;
REG_API reg_match_def reg_default_match_def(void);

typedef struct reg_match reg_match;

/* How a match stands. Distances are those before the last step moved the body, since that is where it looked. */
typedef struct reg_match_info {
    int iterations; /* steps of this match so far */
    reg_match_stop stop;
    sb_real mean_distance;     /* of the active charges from the target, by area (m) */
    sb_real max_distance;      /* m */
    sb_real landmark_distance; /* largest, of landmarks from where they are seen (m) */
    sb_real active;            /* share of the surface's area that acts */
    sb_real charge;            /* Young's moduli */
    sb_real change;            /* largest displacement of a node in the last step (m) */
    int pcg_iterations;        /* of the last step */
    double seconds;            /* of all steps; with a clock, as are those of the last step: */
    double seconds_field;      /* looking for the target, */
    double seconds_system;     /* forces, tangent and preconditioner, */
    double seconds_solve;      /* and the linear system */
    sb_error error;            /* of a call that failed */
} reg_match_info;

/* Makes a match; the body is not touched. SB_ERROR_ARGUMENT (field named), SB_ERROR_NOT_FINITE, SB_ERROR_MATERIAL (no
 * Young's modulus to measure charges with), SB_ERROR_UNSUPPORTED (a body with constraints or custom elements),
 * what reg_field_create says of the target and sb_embedding_create of the surface (points far
 * outside included), SB_ERROR_MEMORY; *match is then untouched. All memory that steps need is taken here. */
REG_API sb_result reg_match_create(const reg_match_def *def, reg_match **match, sb_error *error);
REG_API void reg_match_destroy(reg_match *match); /* NULL is fine; the body stays */

/* One step: moves the body and raises the charge. info may be NULL. On failure the body is as before:
 * SB_ERROR_INVERTED (element named), SB_ERROR_INDEFINITE, SB_ERROR_DIVERGED (also when at full charge the organ
 * has less than a quarter or more than four times its volume); SB_ERROR_NOT_CONVERGED when too little of the
 * surface is near the target; SB_ERROR_UNSUPPORTED when the body has got constraints; SB_ERROR_STATE when its mesh has
 * changed: make a match of it anew. A recording of
 * the body holds the shape that it comes to, and replays without the match. Allocates nothing, unless loads were added
 * to the body since. The same bits for any number of threads. Landmarks and supports may move between steps: matching
 * then follows them. */
REG_API sb_result reg_match_step(reg_match *match, reg_match_info *info);
/* Steps until the match settles, `steps` (>= 0) are done or the time is up: all of these are SB_OK, and info->stop says
 * which. Errors as of a step. */
REG_API sb_result reg_match_run(reg_match *match, int steps, reg_match_info *info);
/* Back to the first charge and reach, as if no step had been: for a body that was reset or moved. The time goes on. */
REG_API void reg_match_restart(reg_match *match);

/* New places of the landmarks, targets[landmark_count] (m): between any two steps. SB_ERROR_NOT_FINITE names none and
 * changes nothing; a settled match runs again. */
REG_API sb_result reg_match_move_landmarks(reg_match *match, const sb_vec3 *targets);
/* Where the landmarks are now (m): points[landmark_count]; untouched when the body's mesh has changed. */
REG_API void reg_match_landmarks(const reg_match *match, sb_vec3 *points);

/* The body's: sb_body_positions and sb_body_displacements are the result. */
REG_API const sb_body *reg_match_body(const reg_match *match);
REG_API reg_match_info reg_match_get_info(const reg_match *match);

/* The charges, for pictures of what acts: [reg_match_sample_count]. */
typedef struct reg_match_sample {
    sb_vec3 point;    /* m, where the last step looked */
    sb_real area;     /* m^2 at rest */
    sb_real distance; /* m from the target */
    int active;
} reg_match_sample;
REG_API int reg_match_sample_count(const reg_match *match);
/* SB_ERROR_INDEX for no such sample; *sample is then untouched. */
REG_API sb_result reg_match_get_sample(const reg_match *match, int index, reg_match_sample *sample);

#endif /* REG_MATCH_H */

/* ==== src/register/nicp.h ==== */
/* nicp: non-rigid ICP: an elastic organ whose visible surface is drawn to its closest points of a target. Floor 6.
 *
 * Points of the organ's surface, the sources, are paired with the target both ways: each source i with the closest
 * place N_s(i) of the target, and each point j of the target with its closest source N_t(j). A source is drawn by
 *     u_i = alpha [p(N_s(i)) - p(i)] + (1 - alpha) mean_{j in V(i)} [p(j) - p'(j)],   V(i) = {j: N_t(j) = i},
 * p'(j) being the place of the organ's surface closest to j; alpha = 1 where V(i) is empty. Pairs that are too far
 * apart for the rest, that look different ways, or that end on the rim of what was seen do not count; nor do sources
 * that the camera does not see. A penalty draws the sources to y = p + u, and the body finds its balance:
 *     f_int(u) + H K (H^T x - y) = loads,   K = k [(1 - s) I + s n n^T]
 * with n across the target and a share s by which it is softer along it. Then all is looked at anew. k grows from
 * increment to increment, k = k0 (k1 / k0)^(i / n): gentle as long as pairs are guesses, firm when they can be trusted.
 *
 * Match (match.h) does the same job by a potential instead of pairs. This one follows scans without normals, uses the
 * camera, and takes bodies in weighted-cell grids and with constraints.
 *
 * Source: Brunet 2020, chapter 5, algorithm 3, with the corrected schedule of k, sign of the penalty and loop counters;
 * its mean over V(i) is of p(j) - p(i), in which the sources' spacing shows as noise along the surface. */
#ifndef REG_NICP_H
#define REG_NICP_H


/* Which sources may be paired. */
typedef enum reg_nicp_view {
    REG_NICP_ALL = 0,    /* all: default; an open target or a cloud tells by itself what it does not show */
    REG_NICP_FACING = 1, /* those whose normal looks to the camera's side */
    REG_NICP_VISIBLE = 2 /* of these, those that no part of the organ hides from the camera */
} reg_nicp_view;

/* Why a run is as far as it is. */
typedef enum reg_nicp_stop {
    REG_NICP_RUNNING = 0,    /* more iterations would help */
    REG_NICP_CONVERGED = 1,  /* two increments running gave the same shape */
    REG_NICP_INCREMENTS = 2, /* the last increment is done */
    REG_NICP_STEP_CAP = 3,   /* the iterations asked for are done */
    REG_NICP_TIME_CAP = 4,   /* def.max_seconds are over */
    REG_NICP_NO_OVERLAP = 5, /* less than def.least_active of the surface has a partner: nothing was moved */
    REG_NICP_FAILED = 6      /* no balance was found, and the body is as before: info.error */
} reg_nicp_stop;

/* What a registration is made from. Start from reg_default_nicp_def(), set body and a target. Lengths are shares of the
 * organ's size: the diagonal of its bounding box. */
typedef struct reg_nicp_def {
    sb_body *body;          /* at rest or deformed; borrowed: it is moved, carries the penalties as mappings (load.h)
                             * while the registration lives, of stiffness 0 between its steps, and must outlive it.
                             * Its supports, loads and constraints act. Gravity too: leave it 0 when the rest shape
                             * already hangs in it */
    const sb_grid *grid;    /* NULL; or the grid whose body_mesh the body has: `surface` is then needed, and goes
                             * through the grid's mapping. Read at creation only, as are all below */
    const sb_mesh *surface; /* surface of the organ at rest, tri or quad, outward, or NULL (default): the boundary of
                             * the body, of one that is cut as a match takes it (see match.h) */
    int sources;            /* most of the surface's vertices that are paired, evenly spread, >= 4; default 4000 */
    const sb_mesh *target;  /* surface that was seen, outward, in the same frame; or NULL, then: */
    const sb_vec3 *target_points;  /* [target_count] cloud (m) */
    const sb_vec3 *target_normals; /* [target_count] outward, or NULL */
    int target_count;
    int samples; /* most points of the target that look for sources, evenly spread, >= 0; default 2000 */
    reg_nicp_view view;
    sb_vec3 camera;        /* where it was seen from (m), in the target's frame; with FACING and VISIBLE */
    sb_real blending;      /* alpha, [0, 1]; default 0.75. 1: only N_s counts */
    sb_real sliding;       /* s, [0, 1]; default 0.999: the organ may slide along the target, whose closest places say
                            * little about that. 0: as in the source, which costs a third of the accuracy. With 1
                            * nothing holds a ball that may turn */
    int noisy;             /* 1: n is the normal of the organ and not that of the target: less is made of the
                            * target's shape, and less of its noise (1 mm on triangles of 4 mm); default 0 */
    sb_real least_cosine;  /* least cosine of the normals of partners, [-1, 1]; default 0.3. Not asked for where the
                            * target has no normals */
    reg_outliers outliers; /* pairs that are too far apart, see reg_outlier_limit; default REG_OUTLIERS_MEDIAN */
    sb_real outlier_parameter; /* default 3 */
    sb_real reach, last_reach; /* pairs nearer than this never are, > 0: falls from increment to increment; default 0.1,
                                * 0.03 */
    sb_real first_stiffness;   /* penalty per area to begin with, in Young's modulus over organ size, > 0;
                                * default 300. Where the organ bends by more than a tenth of its size: 30 */
    sb_real last_stiffness;    /* and in the end, >= first_stiffness; default 30,000. Noisy targets want less: 1000 */
    int increments;            /* of the stiffness, >= 1; default 4 */
    int iterations;            /* most looks at the target in an increment, >= 1; default 2 */
    int newton;                /* most Newton iterations of a balance, >= 1; default 6 */
    sb_real newton_tolerance;  /* of its forces, (0, 1); default 0.07: the next look changes them more than that */
    sb_real tolerance;         /* rms motion of the surface that counts as none, > 0; default 5e-5 */
    sb_real least_active;      /* least share of the surface's area with a partner, [0, 1]; default 0.05. Not asked for
                                * with landmarks */
    const sb_vec3 *landmarks;  /* [landmark_count] points on or in the organ at rest (m), or NULL */
    const sb_vec3 *landmark_targets; /* [landmark_count] where they are seen (m) */
    int landmark_count;
    sb_real landmark_stiffness; /* of each one's spring, in Young's modulus times mean element size, > 0; default 50 */
    double max_seconds;         /* most time of all steps together, > 0; needs `clock`; default 1e9 */
    sb_clock clock;             /* default NULL: times read 0 */
    sb_allocator allocator;     /* default malloc; the threads are the body's */
    unsigned cookie;            /* set by reg_default_nicp_def */
} reg_nicp_def;
REG_API reg_nicp_def reg_default_nicp_def(void);

typedef struct reg_nicp reg_nicp;

/* How it stands. Distances are those before the last step moved the body, since that is where it looked. */
typedef struct reg_nicp_info {
    int iterations; /* looks at the target so far */
    int increment;  /* of the stiffness, from 1 */
    reg_nicp_stop stop;
    sb_real mean_distance;     /* of paired sources from the target, by area (m) */
    sb_real max_distance;      /* m */
    sb_real landmark_distance; /* largest, of landmarks from where they are seen (m) */
    sb_real active;            /* share of the surface's area that is paired */
    int visible;               /* sources that the camera sees */
    int pruned;                /* sources whose partner was too far away, looked elsewhere, or lay on the rim */
    sb_real stiffness;         /* penalty per area (Pa/m) */
    sb_real change;            /* rms motion of the sources in the last step (m) */
    int newton_iterations;     /* of the last step */
    int pcg_iterations;
    double seconds;       /* of all steps; with a clock, as are those of the last step: */
    double seconds_pairs; /* looking for partners, */
    double seconds_solve; /* and finding the balance */
    sb_error error;       /* of a call that failed */
} reg_nicp_info;

/* Makes a registration; the body's shape is not touched, its loads get the penalties, with no force yet.
 * SB_ERROR_ARGUMENT (field named), SB_ERROR_NOT_FINITE, SB_ERROR_MATERIAL (no Young's modulus to measure the penalty
 * with), what reg_field_create says of the target, what sb_surface_create, sb_embedding_create and sb_grid_map_points
 * say of the surface and the landmarks, SB_ERROR_UNSUPPORTED (a body of custom elements), SB_ERROR_MEMORY; *nicp and
 * the body are then untouched. */
REG_API sb_result reg_nicp_create(const reg_nicp_def *def, reg_nicp **nicp, sb_error *error);
REG_API void reg_nicp_destroy(reg_nicp *nicp); /* NULL is fine; takes the penalties away; the body stays as it is */

/* One look at the target and the balance after it. info may be NULL. On failure the body is as before:
 * SB_ERROR_NOT_CONVERGED when too little of the surface has a partner, SB_ERROR_DIVERGED when the organ has less than a
 * quarter or more than four times its volume, and what sb_body_solve_static says; SB_ERROR_STATE
 * when its mesh has changed: make a registration of it anew. Allocates nothing. The same bits for any number
 * of threads. A recording of the body holds the penalties and the balance, and replays without the registration. */
REG_API sb_result reg_nicp_step(reg_nicp *nicp, reg_nicp_info *info);
/* Steps until the shape converges, the increments or `steps` (>= 1) are done, or the time is up: all of these are
 * SB_OK, and info->stop says which. Errors as of a step. */
REG_API sb_result reg_nicp_run(reg_nicp *nicp, int steps, reg_nicp_info *info);
/* Back to the first increment, as if no step had been: for a body that was reset or moved. The time goes on. */
REG_API void reg_nicp_restart(reg_nicp *nicp);

/* New places of the landmarks, targets[landmark_count] (m): between any two steps. SB_ERROR_NOT_FINITE changes nothing;
 * a run that had ended goes on with the last increment. */
REG_API sb_result reg_nicp_move_landmarks(reg_nicp *nicp, const sb_vec3 *targets);
/* Where the landmarks are now (m): points[landmark_count]; untouched when the body's mesh has changed. */
REG_API void reg_nicp_landmarks(const reg_nicp *nicp, sb_vec3 *points);

/* The body's: sb_body_positions and sb_body_displacements are the result. */
REG_API const sb_body *reg_nicp_body(const reg_nicp *nicp);
REG_API reg_nicp_info reg_nicp_get_info(const reg_nicp *nicp);
/* Where the surface is now: points[reg_nicp_surface_count] (m), the vertices of def.surface, or the boundary's nodes in
 * the order of sb_mesh_boundary; untouched when the body's mesh has changed. Through the grid's mapping for bodies in
 * grids. */
REG_API int reg_nicp_surface_count(const reg_nicp *nicp);
REG_API void reg_nicp_positions(const reg_nicp *nicp, sb_vec3 *points);

/* The sources, for pictures of what is paired: [reg_nicp_source_count]. */
typedef struct reg_nicp_source {
    int vertex;       /* of the surface */
    sb_vec3 point;    /* m, where the last step looked */
    sb_vec3 goal;     /* m, where it was drawn to */
    sb_real area;     /* m^2 at rest that it stands for */
    sb_real distance; /* m from the target */
    int visible, active;
} reg_nicp_source;
REG_API int reg_nicp_source_count(const reg_nicp *nicp);
/* SB_ERROR_INDEX for no such source; *source is then untouched. */
REG_API sb_result reg_nicp_get_source(const reg_nicp *nicp, int index, reg_nicp_source *source);

#endif /* REG_NICP_H */

/* ==== src/register/loads.h ==== */
/* loads: which few tractions on its surface give a matched organ its shape. Floor 6.
 *
 * A shape shows motion across the surface only. Where an organ was dragged along it, matching finds the motion of least
 * energy, which may be off by the length of the drag. But what moves an organ (the diaphragm, an instrument, a
 * ligament) acts on compact regions; the rest of its surface bears no load. That is what this room adds: of all
 * tractions, of any direction, that bring the surface to the target it takes those that act on little of it,
 *     minimise  sum_s (n_s . (x_s(f) - t_s))^2 / misfit^2 + sum_i |f_i|^2 / w_i
 * in which f are the forces on the surface's nodes, nothing acts inside, and w_i ~ area (traction + floor)^(2 - power)
 * follows from the tractions found the time before (iteratively reweighted least squares for a sum of powers). The
 * traction of w is averaged with the neighbours', so that loads fill regions.
 *
 * The samples s are means over small parts of the surface; what the surface scatters about them, in each part and in
 * all of them, adds to misfit^2, so that noise of the target and corners that facets cut are seen as such. Their
 * responses to all forces are one column each of the inverse stiffness (see direct.h), after which a round is a dense
 * system in the samples:
 *     (G W G^T + misfit^2) y = gap,   f = W G^T y.
 * Rounds repeat that from the shape found, as the stiffness follows it. The match's landmarks are samples of their
 * own, three each; weaken their springs during the match (landmark_stiffness), or loads have the springs' dents to
 * mend.
 *
 * What acts is mostly a body of its own (the diaphragm, an instrument) that goes one way, and with it the region of
 * the surface that it holds. A surface shows how far a region moved across itself; where its normals differ, one common
 * direction is all that agrees with that, and it tells the motion along the surface. So after two rounds the region
 * that bears loads is taken down and its motions' direction estimated; where they are near one, rounds that follow ask
 * for motions in one direction, which they find, too (`drag`). A direction for which many more loads are needed than
 * without it is dropped, and so is a region of fewer than ten parts, too small to be told from what is around it.
 *
 * The organ's pose can be sought with the loads, held nodes included (`pose`): of all poses the one that needs the
 * least loads. That is for a rigid start from a part of a deformed organ, which may be off by more than a centimetre.
 *
 * Where loads act on most of the surface there is nothing to find, and rounds do not come to rest: a last change of
 * more than a hundredth of the organ's size says so, and the match is the better answer then.
 *
 * The tractions are only as good as the material: the error of the corotated law at strains of a tenth bends what is
 * found more than it mends. Give the body a hyperelastic material (sb_body_set_material, e.g. neo-Hookean) after the
 * match, which needs none; Young's modulus does not matter, Poisson's ratio does. A hyperelastic material admits no
 * elements that are inside out, as firm charges may leave them where the target is noisy: end the match with a
 * last_charge of about 2 then. What the match's charges did not press into shape is found here. */
#ifndef REG_LOADS_H
#define REG_LOADS_H


/* What loads are found from. Start from reg_default_loads_def(), set match. */
typedef struct reg_loads_def {
    reg_match *match;   /* that has run, by distance (REG_PBSM); borrowed. Its charges, target and landmarks are used,
                         * its body is moved. Dead loads and gravity of the body are taken as known */
    int samples;        /* of the surface that the target shows, [30, 3000]; default 300; fewer where that is less than
                         * half of the organ's. Time and memory grow with their square */
    int rounds;         /* at most, [1, 100]; default 10. One that moves no node by a thousandth of the organ's size is
                         * the last, but for those that a drag is still looked for in */
    int reweights;      /* of the first round, [1, 1000]; default 9; later rounds take a third of that */
    sb_real misfit;     /* of a sample, as share of the organ's size, > 0; default 6e-5: what the coarseness of mesh
                         * and model leaves */
    sb_real power;      /* of the tractions, (0, 2]; default 0.5. 2: tractions are spread as evenly as can be; 1: the
                         * sum of forces is least; below: fewer regions, harder edges */
    sb_real floor;      /* tractions that count as none, in shares of the mean, > 0; default 0.01 */
    sb_real landmark;   /* standard deviation of a landmark's place, as share of the organ's size, [1e-6, 1]; default
                         * 1e-3: a third of a millimetre for a liver, what meshes leave */
    sb_real drag;       /* how far the motion of what bears loads may be off one common direction, as share of the
                         * motion, [0, 1); default 0.01. 0: directions are free */
    sb_real pose;       /* standard deviation of the rigid motion by which the organ, held nodes included, is off its
                         * place, as share of its size, >= 0; default 0: held nodes are where they are to be. 0.01
                         * after a rigid start; supports then move along */
    double max_seconds; /* > 0, with a clock: no round begins that would end later, if it takes as long as the one
                         * before; default 1e9 */
    sb_clock clock;     /* default NULL: times read 0 */
    sb_allocator allocator; /* default malloc */
    unsigned cookie;        /* set by reg_default_loads_def */
} reg_loads_def;
REG_API reg_loads_def reg_default_loads_def(void);

typedef struct reg_loads_info {
    int rounds;              /* done */
    sb_real mean_distance;   /* of the charges before the last round (m) */
    sb_real sample_misfit;   /* root mean square of the gaps of the surface's samples that the last round left, as it
                              * foresaw (m) */
    sb_real change;          /* largest displacement of a node in the last round (m): see above */
    sb_vec3 drag;            /* unit vector: the direction that loads moved their region in; 0: none in common */
    sb_real loaded;          /* share of the surface's area that bears more than a twentieth of the largest traction */
    double seconds;          /* of all, with a clock; among them for */
    double seconds_response; /* stiffness, its factor and the samples' responses, */
    double seconds_dense;    /* and the systems in the samples */
    sb_error error;          /* when the call failed */
} reg_loads_info;

/* Moves the body of a match to where loads on little of its surface bring it.
 * forces  [nodes of the body] found (N), 0 inside and where nodes are held; or NULL
 * info    or NULL
 * Returns SB_ERROR_ARGUMENT (a field, named), SB_ERROR_UNSUPPORTED (a Laplacian match; a body with pressures, springs,
 * mappings or constraints), SB_ERROR_STATE (its mesh has changed since the match was made), SB_ERROR_INVERTED (element
 * named), SB_ERROR_INDEFINITE,
 * SB_ERROR_DIVERGED, SB_ERROR_NOT_CONVERGED (nothing of the surface is near the target), SB_ERROR_MEMORY; the
 * body is then as before and forces are untouched. All memory is taken at the beginning and released at the end.
 * Deterministic. */
REG_API sb_result reg_loads_run(const reg_loads_def *def, sb_vec3 *forces, reg_loads_info *info);

#endif /* REG_LOADS_H */

/* ==== src/register/model.h ==== */
/* model: an organ as an inference knows it: mesh, what holds it, the surface that is seen, and what may act on it.
 * Floor 6. */
#ifndef REG_MODEL_H
#define REG_MODEL_H


/* What a model is made from. Start from reg_default_model_def(), set mesh. */
typedef struct reg_model_def {
    const sb_mesh *mesh;    /* of volumes, at rest (m); read during the call only, as all here. Some 6,000 unknowns are
                             * enough: errors of a registration are rarely those of its mesh */
    const sb_mesh *surface; /* the organ's surface at rest, tri or quad, outward, finer than the mesh's; or NULL
                             * (default): the boundary of the mesh */
    sb_real poisson;        /* Poisson's ratio, (-1, 0.5); default 0.45. Young's modulus does not matter: loads scale
                             * with it. Tet4 lock beyond 0.45 */
    const int *fixed;       /* [fixed_count] nodes that move with the organ's pose only, or NULL: loads hold it */
    int fixed_count;
    sb_allocator allocator; /* default malloc; also of what is made with the model */
    sb_jobs jobs;           /* threads; default inline */
    unsigned cookie;        /* set by reg_default_model_def */
} reg_model_def;
REG_API reg_model_def reg_default_model_def(void);

typedef struct reg_model reg_model;

/* Makes a model; everything is copied. SB_ERROR_ARGUMENT (a field, named), SB_ERROR_INDEX (a fixed node),
 * SB_ERROR_UNSUPPORTED (custom elements), what sb_body_create says of the mesh, sb_surface_create and
 * sb_embedding_create of the surface; SB_ERROR_MEMORY. *model is then untouched. One inference at a time may use a
 * model, and the model must outlive it. */
REG_API sb_result reg_model_create(const reg_model_def *def, reg_model **model, sb_error *error);
REG_API void reg_model_destroy(reg_model *model);         /* NULL is fine */
REG_API int reg_model_node_count(const reg_model *model); /* 0 for NULL */

#endif /* REG_MODEL_H */

/* ==== src/register/infer.h ==== */
/* infer: where an organ is and what shape it has, from what is seen of it, and how sure that is. Floor 6.
 *
 *     reg_model_def organ = reg_default_model_def();           (once per organ)
 *     organ.mesh = &mesh;
 *     reg_model_create(&organ, &model, &error);
 *     reg_infer_def def = reg_default_infer_def();
 *     def.model = model;
 *     def.target.points = points, def.target.count = count;    (a scan, m)
 *     def.start = start;                                       (reg_icp's, or whatever is known of the pose)
 *     reg_infer_run(&def, &infer, &error);
 *     reg_infer_displacements(infer, displacements);
 *     reg_infer_get_quality(infer, &quality);                  (quality.expected: the error to expect, m)
 *
 * Nobody knows what acts on an organ: gravity that turned, gas, an instrument, a neighbour that drags it, the hands
 * that hold it. So all of its surface may bear tractions, drawn from a Gaussian process whose scale and places are
 * chosen by what they explain (evidence, MacKay 1992), and its mass a weight in any direction; the organ's pose is open
 * within what the start is sure of. What is seen are gaps between the organ's surface and the points of the scan, each
 * with a deviation. Each round makes the organ's response linear about its present shape (neo-Hookean, exact for large
 * turns), finds the posterior of loads and pose (see gauss.h), and moves there. Where nothing holds the organ its loads
 * balance exactly.
 *
 * Every seen point asks for a place of the surface. What of the surface is not seen is not asked, so that views of any
 * part work, and the answer says how sure it is there: `expected`, from the posterior of loads and pose and from not
 * knowing the organ's stiffness (by a factor of 1.6 in regions of it) and Poisson's ratio (0.02).
 *
 * What to take it for: views of a part. Of organs of 280 mm at random, seven kinds of loads, mesh and law unlike the
 * model's, kept aside while it was tuned (26 views of 30 %, with and without 1 mm of noise; 13 of 10 %; 13 whole), the
 * mean errors were 2.7 mm (start 4.9, reg_loads 3.6), 5.5 (6.2, 5.2) and 1.2 (3.4, 1.0): closer than reg_loads in 20 of
 * 26 and 4 of 13 views, never above 1.1 times the rigid start's error. Of the nodes 93 %, 90 % (views of 10 %) and 93 %
 * were within their regions of 95 %. From a whole surface reg_loads was closer in 10 of 13: take that. (All that was
 * measured when the answer went all of the way, see `sure`.) Beyond that generator, in 1,200 cases of
 * examples/insilico that nothing was tuned on (prescribed motions of four kinds on six organs, whole and from three
 * sides down to 10 % of the surface, 0 to 3 mm of noise), errors were 0.87 times the start's in geometric mean, above
 * 1.1 times in nine, up to 1.5: dents by an instrument, which leave the pose as it is. 579 of 606 errors above 5 mm
 * expect more than that, but so do 204 of the 594 others: the true error scatters about what is expected by a factor
 * of 1.6. Give the model some 2,000
 * nodes.
 *
 * Sources: Rucker et al. 2013 and Heiselman et al. 2020 for responses to loads nobody knows; Matheron's rule for draws
 * (Wilson et al. 2021). */
#ifndef REG_INFER_H
#define REG_INFER_H


/* What is seen of the organ. Everything is borrowed during the call. Zero-initialise. */
typedef struct reg_points {
    const sb_vec3 *points;  /* [count] m */
    const sb_vec3 *normals; /* [count] outward, of any length, 0: unknown; or NULL. They only forbid places of the model
                             * that face the other way */
    const sb_real *sd;      /* [count] standard deviation of a point across the surface (m), > 0; or NULL: estimated */
    const sb_real *weights; /* [count] >= 0, trust; or NULL: 1 */
    int count;
    const sb_mesh *surface; /* or, in place of points: a surface, tri or quad, of which the nodes count by area */
    int has_camera;         /* 1: seen from `camera` (m): facets of the model that look away are not seen */
    sb_vec3 camera;
} reg_points;

/* A point of the organ and where it is seen. */
typedef struct reg_landmark {
    sb_vec3 model; /* m, on or in the organ at rest */
    sb_vec3 seen;  /* m */
    sb_real sd;    /* standard deviation per axis (m), >= 0; 0: met exactly; infinite: counts nothing */
} reg_landmark;

/* A line of the organ and what is seen of it: a ridge, a rim, the root of a ligament, a vessel's centre line. It may
 * slide along itself. Doubling the corners of a line changes nothing: what is seen is taken every fiftieth of the
 * organ's size, at 32 places at most, each as sure as `sd` says. It is believed: what is taken for another line of the
 * organ draws the answer wrong. A vessel through nine random organs of 0.3 m, seen to 0.5 mm beside 30 % of their
 * surface, took mean errors from 4.2 to 2.2 mm; a quarter of it, beside a tenth, from 4.8 to 4.0. */
typedef struct reg_curve {
    const sb_vec3 *model; /* [model_count] m, corners of the line on or in the organ at rest; a part may be unseen */
    int model_count;      /* [2, 1000] */
    const sb_vec3 *seen;  /* [seen_count] m, corners of what is seen, in order, from either end */
    int seen_count;       /* >= 2 */
    sb_real sd;           /* standard deviation across the line, per axis (m), > 0; infinite: counts nothing */
} reg_curve;

/* What is asked. Start from reg_default_infer_def(), set model and target. */
typedef struct reg_infer_def {
    reg_model *model; /* borrowed; it must outlive the inference */
    reg_points target;
    const reg_landmark *landmarks; /* [landmark_count] or NULL */
    int landmark_count;
    const reg_curve *curves; /* [curve_count] or NULL */
    int curve_count;
    reg_rigid start;    /* model to target: a pose nearby; default: none but the model's own */
    sb_real start_sd;   /* of the place that it gives the organ's middle (m), at most 100 of its sizes; default 0: 0.07
                         * of the size */
    sb_real start_turn; /* and of its turn (rad), in (0, 10]; default 0.2 */
    int gravity;        /* 1 (default): the weight may have changed, as where a patient is turned; 0: it did not */
    const sb_real *pressed; /* [model's nodes], in [0, 1], or NULL (default): a pressure, of either sign and any size,
                             * may press on the skin besides, with such a share of it at each node: gas in the abdomen
                             * on what it reaches, water in a cyst. Say so where you know it: of other loads nobody
                             * expects that they are alike in all places. Its sum is carried by other loads. Where all
                             * is seen its size is found, too (a sphere's to 3 %). Of 11 random organs under gas, a
                             * third seen from above, it hardly was; errors were 0.96 of those without the hint on
                             * the mean, from 0.71 to 1.30. A region that nothing pressed on changed none of seven by
                             * more than 1 % of it */
    int samples;            /* patches that the target is grouped into, [30, 1000]; default 300. Time grows with it */
    int rounds;             /* at most, [1, 100]; default 5: more gain little */
    double max_seconds;     /* > 0, with a clock: no round begins that would end later; default 1e9 */
    sb_clock clock;         /* default NULL: times read 0 */
    unsigned cookie;        /* set by reg_default_infer_def */
} reg_infer_def;
REG_API reg_infer_def reg_default_infer_def(void);

typedef struct reg_infer reg_infer;

/* Infers; all memory is taken here, from the model's allocator. SB_ERROR_ARGUMENT (a field, named),
 * SB_ERROR_NOT_FINITE (error->node: the point, the landmark or the curve), what sb_surface_create says of a target
 * surface, SB_ERROR_NOT_CONVERGED (no point of the target has an allowed place of the model, or loads cannot be told),
 * SB_ERROR_INDEFINITE, SB_ERROR_MEMORY: *infer is then untouched. Deterministic; the same bits for any number of
 * threads, without a time limit. */
REG_API sb_result reg_infer_run(const reg_infer_def *def, reg_infer **infer, sb_error *error);
REG_API void reg_infer_destroy(reg_infer *infer); /* NULL is fine; the model stays */

/* ---- the answer: SB_ERROR_ARGUMENT for NULL -------------------------------------------------------------------- */

/* displacements[nodes] (m) of the model's nodes from rest to where they are in the target's frame. Where less than 15 %
 * of the surface is seen and no landmark or curve was given, a tenth tells too little of the rest: the answer is then
 * half the way from the start to the elastic shape, or the start where loads explain no more than a pose does
 * (quality.belief). Without landmarks and curves all answers stop short of the elastic shape by as much as it is unsure
 * for how far from the start it is (quality.sure). What is left of the way is in the errors to expect. */
REG_API sb_result reg_infer_displacements(const reg_infer *infer, sb_vec3 *displacements);
/* forces[nodes] (N for a Young's modulus of 1000 Pa: they scale with it) that are found to act, weight included: those
 * of the whole way, of which the answer goes quality.sure. */
REG_API sb_result reg_infer_forces(const reg_infer *infer, sb_vec3 *forces);
/* expected[nodes]: root mean square error (m) to expect of each node. */
REG_API sb_result reg_infer_expected(const reg_infer *infer, sb_real *expected);
/* One of the REG_INFER_DRAWS shapes that agree with what was seen, as displacements[nodes] (m) like the answer's: to
 * see in how many of them a path misses. SB_ERROR_INDEX. */
enum { REG_INFER_DRAWS = 32 };
REG_API sb_result reg_infer_draw(const reg_infer *infer, int index, sb_vec3 *displacements);
/* Where points[count] of the organ at rest (m) are, moved[count], and the covariance of that, covariances[count] (m^2);
 * either may be NULL. SB_ERROR_NOT_FINITE, what sb_embedding_create says of points far off, SB_ERROR_MEMORY
 * leave both untouched. From the draws, so that single covariances are known to a quarter. */
REG_API sb_result reg_infer_covariance(const reg_infer *infer, const sb_vec3 *points, int count, sb_vec3 *moved,
                                       sb_mat3 *covariances, sb_error *error);
/* Which of points[count] of the organ at rest (m) is worth touching: the one that, seen as a landmark of deviation `sd`
 * (m, >= 0), lowers the mean error to expect most, and what that would then be, expected (m); it may be NULL. It takes
 * the draws for all that may be (regression on them); that with a landmark an answer goes the whole way is not in it.
 * Of three random organs seen from above 7.0 to 7.8 mm became 5.2 to 5.8, foretold 5.5 to 6.3; the best of nine points
 * was found in two of them, in the third one 1.2 times as good as that. SB_ERROR_ARGUMENT, and as above: nothing is
 * written then. 1 ms per point for 2,000 nodes. */
REG_API sb_result reg_infer_best_landmark(const reg_infer *infer, const sb_vec3 *points, int count, sb_real sd,
                                          int *best, sb_real *expected, sb_error *error);

/* ---- how good it is --------------------------------------------------------------------------------------------- */

typedef enum reg_infer_stop {
    REG_INFER_CONVERGED = 0, /* the last round moved no node by a thousandth of the size */
    REG_INFER_ROUNDS = 1,    /* the rounds asked for are done */
    REG_INFER_CAPPED = 2     /* time was up */
} reg_infer_stop;

/* What the loads that won are like. */
typedef enum reg_prior_kind {
    REG_PRIOR_RIGID = 0,   /* loads explain hardly more than a pose does: by less than 3 nats */
    REG_PRIOR_SMOOTH = 1,  /* tractions of like size everywhere */
    REG_PRIOR_LOCAL = 2,   /* tractions of some places */
    REG_PRIOR_GRAVITY = 3, /* a weight, and tractions that carry it */
    REG_PRIOR_PRESSURE = 4 /* a pressure on what is `pressed`, of 3 nats or more, and other tractions; there may be a
                            * weight, too */
} reg_prior_kind;

typedef struct reg_quality {
    reg_infer_stop stop;
    unsigned warnings; /* REG_WARN_..., or-ed. VIEW_SMALL: also where the error to expect is above 0.03 of the size;
                        * LOW_CONTRAST: the pose is open by 2 % of the size or 5 degrees */
    reg_prior_kind prior;
    sb_real prior_margin;             /* log evidence over that of no loads, tempered */
    sb_real pressure_margin;          /* log evidence of a pressure on what is pressed over none, tempered; 0: none */
    sb_real pressure;                 /* found there, for a Young's modulus of 1000 Pa (Pa, > 0: inwards) */
    sb_real belief;                   /* share of the way from the start to the elastic shape that the answer goes: */
    sb_real sure;                     /* this times that; less than 1 the less sure the way is for its length */
    sb_real seen;                     /* share of the model's surface with points of the target near */
    sb_real used;                     /* share of the target's weight that was believed */
    sb_real noise;                    /* m: standard deviation of the points across the surface, estimated */
    sb_real misfit;                   /* m: of what does not average out, as facets, chosen by evidence */
    sb_real residual, residual_p95;   /* m: distances of the points believed, mean and 95th percentile */
    sb_real expected, expected_worst; /* m: root mean square error to expect, mean over nodes, and of the worst */
    sb_real pose_sd[2];               /* m, rad: largest of the pose's deviations */
    sb_real largest_strain;           /* |principal stretch - 1|, of all points of elements */
    sb_real volume_ratio;
    sb_real change; /* m: largest displacement in the last round */
    int rounds;
    double seconds;          /* of all, with a clock; among them for */
    double seconds_response; /* stiffness, its factor and the patches' responses, */
    double seconds_choice;   /* the choice of the prior, */
    double seconds_draws;    /* and what the error to expect comes from */
} reg_quality;
/* SB_ERROR_ARGUMENT. */
REG_API sb_result reg_infer_get_quality(const reg_infer *infer, reg_quality *quality);
/* "rigid", "smooth", "local", "gravity", "pressure"; "converged", "rounds", "time". */
REG_API const char *reg_prior_string(reg_prior_kind prior);
REG_API const char *reg_infer_stop_string(reg_infer_stop stop);

#endif /* REG_INFER_H */

/* ==== src/register/track.h ==== */
/* track: follows an organ that moves, scan by scan. Floor 6.
 *
 *     reg_track_def def = reg_default_track_def();
 *     def.model = model;
 *     def.start = infer;                                  (of the first scan; or def.pose)
 *     reg_track_create(&def, &track, &error);
 *     every frame:
 *         reg_track_set_target(track, &points, &error);   (the scan of now; none where it dropped out)
 *         reg_track_set_features(track, marks, NULL, &error); (landmarks and curves of now, if def names some)
 *         reg_track_step(track, dt, &info);
 *         reg_track_displacements(track, displacements);
 *     reg_track_destroy(track);
 *
 * Where an inference (infer.h) takes part of a second to find an organ of which nothing is known, a tracker takes
 * milliseconds to follow one that is known. Its state is a pose and the amounts of `modes` shapes, those that carry
 * most of what tractions drawn from the prior do to the organ; all is Gaussian. Between scans the pose wanders, and the
 * amounts go back to the start as a process of Ornstein and Uhlenbeck does, so that errors to expect grow in a
 * drop-out, but not beyond what loads may do. A scan brings gaps between the surface and the points, as rows of the
 * state; places on the surface are looked for twice. Each target counts in one step. What a coarse surface is off by
 * does not average out over frames: so the change since the last frame is drawn from a prior whose scale evidence
 * chooses, and the error to expect is what this frame alone leaves open. (A Kalman filter that takes such errors for
 * noise grows sure of them, and drifts.) Three targets on end that agree with nothing that was expected (gaps too
 * large, or far fewer points than lately to be believed) are a jump: all is open again about where the organ was, and
 * the next frames search wider.
 *
 * What to take it for: five random organs of 0.3 m, of another mesh and law than the model's (450 to 530 nodes), drawn
 * by 3 % of their size over a wide part and swaying, seen from above by 600 points of 0.7 mm noise ten times a second:
 * 1.5 to 2.1 mm off inside on the mean (2.7 to 3.4 expected), where a tracker of poses is 1.9 to 2.5 off; worst 1.06
 * times that. A breathing liver (examples/track_liver.c): 1.1 mm, 2.0 expected, 2.3 in drop-outs of 0.4 s. A frame of
 * 700 points and a model of 1,887 nodes takes 3 ms of one core.
 *
 * What is left is no lag and no noise, but what a smooth surface does not tell: how it slides along itself. Without
 * noise, at 30 Hz, or with all of the surface seen errors are the same (2.1, 2.1 and 2.2 mm of five organs; the best
 * rigid motion is 1.7 off, the best amounts of the shapes 0.5), and the error to expect says so. Landmarks and curves
 * do tell (reg_track_set_features): of ten organs whose upper third is seen, 2.3 -> 1.8 mm with two points of the
 * flanks and a ridge below; of the breathing liver 1.1 -> 0.53 with two points and two lines.
 *
 * The shapes are linear about the start. Strains of a tenth, or parts that turn by 20 degrees against each other, are
 * beyond that: restart about where the organ is then (reg_track_restart).
 *
 * Sources: MacKay 1992 for evidence; Halko et al. 2011 for the search of shapes. */
#ifndef REG_TRACK_H
#define REG_TRACK_H


/* What is asked. Start from reg_default_track_def(), set model. */
typedef struct reg_track_def {
    reg_model *model;       /* borrowed; it must outlive the tracker. Steps leave it alone, so that an inference may use
                             * it meanwhile; creation and restarts use it as an inference does */
    const reg_infer *start; /* of this model: where the organ is and what shape it has, read during the call; or NULL */
    reg_rigid pose;         /* for start NULL: the organ is at rest there; default: none but the model's own */
    sb_real pose_sd;        /* m: what the place of the organ's middle may be off at the start; default 0: what `start`
                             * says, or 0.02 of the size */
    sb_real pose_turn;      /* rad, in [0, 10]: and its turn; default 0: what `start` says, or 0.05 */
    int modes;              /* shapes, [1, 96]; default 48 */
    int patches;            /* of the surface, whose points count as one datum each, [30, 1000]; default 300 */
    int most_points;        /* of a target, [1, 10000000]; default 2000 */
    sb_real motion;         /* m: root mean square motion of the nodes by loads to expect, beside the pose; default 0:
                             * 0.03 of the size */
    sb_real memory;         /* s, > 0: in that amounts go back towards the start; default 1 */
    sb_real wander;         /* m: deviation of the middle after a second, per axis; default 0: 0.04 of the size */
    sb_real turn;           /* rad, in [0, 10]: and of the turn; default 0: 0.15 */
    sb_real misfit;         /* m: of what does not average out, as facets; default 0: what `start` found, or what the
                             * model's nodes let expect */
    double lost_after;      /* s, > 0: without a target or features for longer the organ is lost; default 0.5 */
    const reg_landmark *landmarks; /* [landmark_count] or NULL: points of the organ that frames may tell of. Their
                                    * `model` is copied; where they are seen, and how sure, comes with each frame */
    int landmark_count;            /* [0, 1000] */
    const reg_curve *curves;       /* [curve_count] or NULL: lines of the organ likewise: ridges, vessels */
    int curve_count;               /* [0, 1000] */
    sb_clock clock;                /* default NULL: times read 0 */
    unsigned cookie;               /* set by reg_default_track_def */
} reg_track_def;
REG_API reg_track_def reg_default_track_def(void);

typedef struct reg_track reg_track;

/* Makes a tracker; all memory is taken here, from the model's allocator. Takes the time of a round of an inference.
 * SB_ERROR_ARGUMENT (a field, named), SB_ERROR_INVERTED, SB_ERROR_INDEFINITE, SB_ERROR_MEMORY: *track is then
 * untouched. Deterministic, as steps are; the same bits for any number of threads. */
REG_API sb_result reg_track_create(const reg_track_def *def, reg_track **track, sb_error *error);
REG_API void reg_track_destroy(reg_track *track); /* NULL is fine; the model stays */

/* Begins anew about an inference's answer, or, `start` NULL, about where the organ is now: shapes are linear about
 * that, what was known of the amounts is forgotten, and the pose is as sure as at a start. For after it was lost, and
 * for large deformations. Allocates nothing; takes as long as the creation. The errors of reg_track_create: nothing
 * has changed then. A target that waits stays. */
REG_API sb_result reg_track_restart(reg_track *track, const reg_infer *start, sb_error *error);

/* What is seen now, for the next step; replaces a target that waits. Copied. A surface is refused. SB_ERROR_ARGUMENT,
 * also for more than def.most_points, and SB_ERROR_NOT_FINITE (error->node: the point): nothing has changed. */
REG_API sb_result reg_track_set_target(reg_track *track, const reg_points *target, sb_error *error);

/* Which of the def's landmarks and curves are seen now, and where, for the next step: landmarks[def.landmark_count] and
 * curves[def.curve_count] in the def's order, of which `seen` and `sd` are read and copied. An infinite sd stands for
 * what is not seen now: it counts nothing, and its `seen` is not looked at. Replaces features that wait; a step takes
 * them in beside a target or without one. They are rows of the state, as patches of the target are, but counted for
 * what they are by themselves: the farther one is off what was expected of it, the less it counts (Student's t of three
 * degrees of freedom), so that one that is taken for another does little, while all that move alike are followed.
 * Deviations below a ten-thousandth of the organ's size count as that.
 *
 * NULL where the def has none. SB_ERROR_ARGUMENT (NULL, an sd out of its range, a line without length, a place farther
 * than 100 of the organ's sizes from where it is: most often one in millimetres) and SB_ERROR_NOT_FINITE name the
 * landmark or curve (error->node): nothing has changed. Allocates nothing. */
REG_API sb_result reg_track_set_features(reg_track *track, const reg_landmark *landmarks, const reg_curve *curves,
                                         sb_error *error);

typedef enum reg_track_state {
    REG_TRACK_FOLLOWS = 0,  /* the target was taken in */
    REG_TRACK_PREDICTS = 1, /* there was none, nor a feature, nothing of it had an allowed place, or the step failed:
                             * the organ is where it was */
    REG_TRACK_JUMPED = 2,   /* three targets in a row agreed with nothing that was expected: all is open again */
    REG_TRACK_LOST = 3      /* no target for longer than def.lost_after: restart, from reg_icp's or another pose */
} reg_track_state;

typedef struct reg_track_info {
    reg_track_state state;
    double time;      /* s: sum of all steps */
    double blind;     /* s since the last target that was taken in */
    sb_real seen;     /* share of the surface with points that are believed, this frame */
    sb_real used;     /* share of the target's weight that was believed */
    sb_real noise;    /* m: standard deviation of the points across the surface, estimated */
    sb_real trusted;  /* of landmarks and places of curves seen: how much they count, [0, 1], mean; 0: none was seen */
    sb_real residual; /* m: mean distance of the points believed from the surface, before the last correction */
    sb_real innovation; /* squared gaps over what was expected of them, mean: about 1 or less */
    sb_real expected;   /* m: root mean square error to expect, over the nodes */
    double seconds;     /* with a clock */
    sb_error error;     /* of a step that failed */
} reg_track_info;

/* Goes on by dt (s, > 0), and takes in the target and the features that wait, if there are any. Allocates nothing. info
 * may be NULL. SB_ERROR_ARGUMENT, SB_ERROR_INDEFINITE, SB_ERROR_NOT_FINITE: nothing has changed but that target and
 * features are gone. */
REG_API sb_result reg_track_step(reg_track *track, double dt, reg_track_info *info);

/* ---- where it is: SB_ERROR_ARGUMENT for NULL -------------------------------------------------------------------- */

/* displacements[nodes] (m) of the model's nodes from rest to where they are in the target's frame. */
REG_API sb_result reg_track_displacements(const reg_track *track, sb_vec3 *displacements);
/* covariances[nodes] (m^2) of that, in the target's frame. Some (modes + 6)^2 multiply-adds a node: for a look now and
 * then, not for each frame. */
REG_API sb_result reg_track_covariances(const reg_track *track, sb_mat3 *covariances);

/* ---- undo, replays, a start where another run ended -------------------------------------------------------------- */

/* A saved tracker holds all that steps, restarts and targets change, what waits included: what follows a load
 * is what followed the save, bit for bit, also in another process or machine. It is loaded into a tracker of the same
 * model that was made with the same def (most_points may differ), in the same precision. Some
 * 3 (modes + 1) reals a node. The model and its body are not part of it: steps leave them alone.
 *
 * size: bytes that save writes for the tracker as it is; 0 for NULL. save: what is behind them stays.
 * SB_ERROR_ARGUMENT: NULL, or too small a buffer (then untouched). Neither allocates. */
REG_API size_t reg_track_save_size(const reg_track *track);
REG_API sb_result reg_track_save(const reg_track *track, void *buffer, size_t size);
/* Allocates nothing. Everything is checked first; on failure the tracker is as it was: SB_ERROR_ARGUMENT (NULL),
 * SB_ERROR_FORMAT (no saved tracker, cut short, damaged, a number out of its range), SB_ERROR_UNSUPPORTED (other
 * version or precision), SB_ERROR_STATE (another model's or def's), SB_ERROR_NOT_FINITE. */
REG_API sb_result reg_track_load(reg_track *track, const void *buffer, size_t size, sb_error *error);

/* "follows", "predicts", "jumped", "lost". */
REG_API const char *reg_track_state_string(reg_track_state state);

#endif /* REG_TRACK_H */

#endif /* REGISTER_H */

#if defined(REG_IMPLEMENTATION) && !defined(REG_IMPLEMENTATION_DONE)
#define REG_IMPLEMENTATION_DONE

/* ==== src/register/kdtree.h, internal ==== */
/* The points' indices in the order of the leaves, so that queries in this order find what they need in the cache:
 * order[count]. */
REGI_API void regi_kdtree_order(const reg_kdtree *tree, int *order);
/* reg_kdtree_nearest for a finite point, with the answer to begin with: index `found` (INT_MAX: none) at the squared
 * distance *squared. */
REGI_API int regi_kdtree_nearest_from(const reg_kdtree *tree, sb_vec3 point, int found, sb_real *squared);

/* ==== src/register/cloud.h, internal ==== */
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

/* ==== src/register/field.h, internal ==== */
/* 1 for a cloud, and for a surface with a rim: it may be a part of something. */
REGI_API int regi_field_is_open(const reg_field *field);

/* ==== src/register/rigid.c ==== */
/* rigid: motions and Kabsch's fit. */

REG_API reg_rigid reg_rigid_identity(void)
{
    reg_rigid motion;
    motion.rotation = sb_m3_identity();
    motion.translation = sb_v3(0, 0, 0);
    return motion;
}

REG_API sb_vec3 reg_rigid_apply(const reg_rigid *motion, sb_vec3 point)
{
    if (!motion)
        return sb_v3(0, 0, 0);
    return sb_v3_add(sb_m3_apply(motion->rotation, point), motion->translation);
}

REG_API reg_rigid reg_rigid_compose(const reg_rigid *then, const reg_rigid *first)
{
    reg_rigid none;
    reg_rigid motion;
    if (!then || !first) {
        memset(&none, 0, sizeof none);
        return none;
    }
    motion.rotation = sb_m3_mul(then->rotation, first->rotation);
    motion.translation = reg_rigid_apply(then, first->translation);
    return motion;
}

REG_API reg_rigid reg_rigid_inverse(const reg_rigid *motion)
{
    reg_rigid none;
    reg_rigid inverse;
    if (!motion) {
        memset(&none, 0, sizeof none);
        return none;
    }
    inverse.rotation = sb_m3_transpose(motion->rotation);
    inverse.translation = sb_v3_scale(-1, sb_m3_apply(inverse.rotation, motion->translation));
    return inverse;
}

/* The axis times 2 sin, and 1 + 2 cos: together they determine small angles and angles near pi alike. */
REG_API sb_real reg_rigid_angle(const reg_rigid *motion)
{
    const sb_mat3 *r = motion ? &motion->rotation : NULL;
    sb_vec3 axis;
    if (!r)
        return 0;
    axis = sb_v3(r->m[2][1] - r->m[1][2], r->m[0][2] - r->m[2][0], r->m[1][0] - r->m[0][1]);
    return sb_atan2(sb_v3_norm(axis), r->m[0][0] + r->m[1][1] + r->m[2][2] - 1);
}

static sb_result regi_rigid_check(const sb_vec3 *from, const sb_vec3 *to, const sb_real *weights, int count,
                                  sb_error *error)
{
    sb_real largest = 0;
    if (!from || !to || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a fit needs at least one pair of points, not %d", count);
    for (int i = 0; i < count; i++) {
        sb_real w = weights ? weights[i] : 1;
        if (!sb_v3_is_finite(from[i]) || !sb_v3_is_finite(to[i]) || !sb_is_finite(w))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "pair %d is not finite", i);
        if (w < 0)
            return sbi_fail(error, SB_ERROR_ARGUMENT, "the weight of pair %d is %g, not 0 or more", i, (double)w);
        largest = w > largest ? w : largest;
    }
    if (!(largest > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "all weights are 0");
    return SB_OK;
}

REG_API sb_result reg_rigid_fit(const sb_vec3 *from, const sb_vec3 *to, const sb_real *weights, int count,
                                reg_rigid *motion, sb_error *error)
{
    sb_result result = motion ? regi_rigid_check(from, to, weights, count, error)
                              : sbi_fail(error, SB_ERROR_ARGUMENT, "reg_rigid_fit needs a place for the motion");
    sb_vec3 mean_from = sb_v3(0, 0, 0), mean_to = mean_from, stretches;
    sb_mat3 spread = sb_m3_zero(), u, v;
    sb_real total = 0;
    if (result != SB_OK)
        return result;
    for (int i = 0; i < count; i++) {
        sb_real w = weights ? weights[i] : 1;
        if (!(w > 0))
            continue;
        total += w;
        mean_from = sb_v3_madd(mean_from, w / total, sb_v3_sub(from[i], mean_from));
        mean_to = sb_v3_madd(mean_to, w / total, sb_v3_sub(to[i], mean_to));
    }
    for (int i = 0; i < count; i++) {
        sb_vec3 a = sb_v3_scale((weights ? weights[i] : 1) / total, sb_v3_sub(to[i], mean_to));
        spread = sb_m3_add(spread, sb_m3_outer(a, sb_v3_sub(from[i], mean_from)));
    }
    /* u and v of this factorisation are rotations, the sign of the determinant is in the last stretch: u v^T is the
     * nearest rotation. */
    sb_m3_svd(spread, &u, &stretches, &v);
    motion->rotation = sb_m3_mul(u, sb_m3_transpose(v));
    motion->translation = sb_v3_sub(mean_to, sb_m3_apply(motion->rotation, mean_from));
    return SB_OK;
}

/* ==== src/register/kdtree.c ==== */
/* kdtree: building by medians, and queries that walk down the nearer half first.
 *
 * The tree is complete: node i has the children 2i and 2i + 1, the leaves come last, and leaf j of L holds the points
 * from floor(n j / L) on. Distances and the bounds of boxes are sums of three squares in one order; each rounding is
 * monotone, so a bound never exceeds the distance of a point in the box, and nothing is lost to rounding. */

#include <limits.h>

enum { REGI_KDTREE_LEAF = 8, REGI_KDTREE_STACK = 40 };

/* Boxes around the two children. */
typedef struct regi_kdtree_node {
    sb_real low[3][2], high[3][2];
} regi_kdtree_node;

typedef struct regi_kdtree_leaf {
    sb_real x[REGI_KDTREE_LEAF], y[REGI_KDTREE_LEAF], z[REGI_KDTREE_LEAF]; /* NaN where there is no point */
    int index[REGI_KDTREE_LEAF];
} regi_kdtree_leaf;

struct reg_kdtree {
    sb_allocator allocator;
    regi_kdtree_node *nodes; /* [leaf_count]; 0 is unused */
    regi_kdtree_leaf *leaves;
    int leaf_count; /* a power of 2 */
    int count;
};

/* ---- building ---------------------------------------------------------------------------------------------------- */

typedef struct regi_kdtree_point {
    sb_real x[3];
    int index;
} regi_kdtree_point;

static void regi_kdtree_swap(regi_kdtree_point *a, regi_kdtree_point *b)
{
    regi_kdtree_point t = *a;
    *a = *b;
    *b = t;
}

/* Hoare's selection: what belongs at `middle` gets there, smaller ones before it. The pivot is drawn, so that no
 * arrangement of the points is slow; scans stop at equal keys, so that many equal points are split evenly. */
static void regi_kdtree_select(regi_kdtree_point *p, int low, int high, int middle, int axis)
{
    uint32_t draw = 2463534242u;
    while (low < high) {
        int i = low, j = high;
        sb_real pivot;
        draw ^= draw << 13, draw ^= draw >> 17, draw ^= draw << 5;
        pivot = p[low + (int)(draw % (uint32_t)(high - low + 1))].x[axis];
        while (i <= j) {
            while (p[i].x[axis] < pivot)
                i++;
            while (pivot < p[j].x[axis])
                j--;
            if (i <= j)
                regi_kdtree_swap(p + i++, p + j--);
        }
        if (middle <= j)
            high = j;
        else if (middle >= i)
            low = i;
        else
            return;
    }
}

static int regi_kdtree_start(const reg_kdtree *tree, int leaf)
{
    return (int)((int64_t)tree->count * leaf / tree->leaf_count);
}

/* Fills leaf `leaf` with the points from..to. */
static void regi_kdtree_fill(reg_kdtree *tree, int leaf, const regi_kdtree_point *p, int from, int to)
{
    regi_kdtree_leaf *out = tree->leaves + leaf;
    for (int i = 0; i < REGI_KDTREE_LEAF; i++) {
        int there = from + i < to;
        out->x[i] = there ? p[from + i].x[0] : (sb_real)INFINITY;
        out->y[i] = there ? p[from + i].x[1] : (sb_real)INFINITY;
        out->z[i] = there ? p[from + i].x[2] : (sb_real)INFINITY;
        out->index[i] = there ? p[from + i].index : -1;
    }
}

/* Builds `node` over the leaves first .. first + leaves - 1, and notes its box with its parent. */
static void regi_kdtree_build(reg_kdtree *tree, regi_kdtree_point *p, int node, int first, int leaves)
{
    int from = regi_kdtree_start(tree, first), to = regi_kdtree_start(tree, first + leaves), widest = 0;
    sb_real low[3], high[3];
    for (int a = 0; a < 3; a++)
        low[a] = high[a] = p[from].x[a];
    for (int i = from + 1; i < to; i++)
        for (int a = 0; a < 3; a++) {
            low[a] = sb_min(low[a], p[i].x[a]);
            high[a] = sb_max(high[a], p[i].x[a]);
        }
    for (int a = 0; a < 3; a++) {
        if (high[a] - low[a] > high[widest] - low[widest])
            widest = a;
        if (node > 1) {
            tree->nodes[node / 2].low[a][node % 2] = low[a];
            tree->nodes[node / 2].high[a][node % 2] = high[a];
        }
    }
    if (leaves == 1) {
        regi_kdtree_fill(tree, first, p, from, to);
        return;
    }
    regi_kdtree_select(p, from, to - 1, regi_kdtree_start(tree, first + leaves / 2), widest);
    regi_kdtree_build(tree, p, 2 * node, first, leaves / 2);
    regi_kdtree_build(tree, p, 2 * node + 1, first + leaves / 2, leaves / 2);
}

static sb_result regi_kdtree_check(const sb_vec3 *points, int count, sb_error *error)
{
    sb_real most = sb_sqrt(SB_REAL_MAX) / 8;
    if (!points || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a tree needs at least one point, not %d", count);
    for (int i = 0; i < count; i++) {
        if (!sb_v3_is_finite(points[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "point %d has a coordinate that is not finite", i);
        if (sb_abs(points[i].x) > most || sb_abs(points[i].y) > most || sb_abs(points[i].z) > most)
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "point %d is too far from the origin to be squared", i);
    }
    return SB_OK;
}

static reg_kdtree *regi_kdtree_allocate(int count, const sb_allocator *allocator)
{
    reg_kdtree *tree = NULL;
    int leaf_count = 1;
    while ((int64_t)leaf_count * REGI_KDTREE_LEAF < count)
        leaf_count *= 2;
    for (sbi_arena arena = {NULL, 0, 0};;) {
        reg_kdtree *head = (reg_kdtree *)sbi_arena_take(&arena, 1, sizeof(reg_kdtree));
        regi_kdtree_node *nodes = (regi_kdtree_node *)sbi_arena_take(&arena, (size_t)leaf_count, sizeof *nodes);
        regi_kdtree_leaf *leaves = (regi_kdtree_leaf *)sbi_arena_take(&arena, (size_t)leaf_count, sizeof *leaves);
        if (arena.base) {
            tree = head;
            tree->nodes = nodes;
            tree->leaves = leaves;
            tree->leaf_count = leaf_count;
            tree->count = count;
            memset(&tree->allocator, 0, sizeof tree->allocator);
            if (allocator)
                tree->allocator = *allocator;
            return tree;
        }
        arena.base = arena.overflow ? NULL : (unsigned char *)sbi_alloc(allocator, 1, arena.used);
        arena.used = 0;
        if (!arena.base)
            return NULL;
    }
}

REG_API sb_result reg_kdtree_create(const sb_vec3 *points, int count, const sb_allocator *allocator, reg_kdtree **tree,
                                    sb_error *error)
{
    sb_result result = regi_kdtree_check(points, count, error);
    regi_kdtree_point *scratch;
    reg_kdtree *made;
    if (result != SB_OK)
        return result;
    if (!tree)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "nowhere to put the tree");
    made = regi_kdtree_allocate(count, allocator);
    scratch = made ? (regi_kdtree_point *)sbi_alloc(allocator, (size_t)count, sizeof *scratch) : NULL;
    if (!scratch) {
        reg_kdtree_destroy(made);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a tree of %d points", count);
    }
    for (int i = 0; i < count; i++) {
        scratch[i].x[0] = points[i].x;
        scratch[i].x[1] = points[i].y;
        scratch[i].x[2] = points[i].z;
        scratch[i].index = i;
    }
    regi_kdtree_build(made, scratch, 1, 0, made->leaf_count);
    sbi_free(allocator, scratch);
    *tree = made;
    return SB_OK;
}

REG_API void reg_kdtree_destroy(reg_kdtree *tree)
{
    if (tree) {
        sb_allocator allocator = tree->allocator;
        sbi_free(&allocator, tree);
    }
}

REGI_API void regi_kdtree_order(const reg_kdtree *tree, int *order)
{
    for (int leaf = 0, n = 0; leaf < tree->leaf_count; leaf++)
        for (int i = 0; i < REGI_KDTREE_LEAF && tree->leaves[leaf].index[i] >= 0; i++)
            order[n++] = tree->leaves[leaf].index[i];
}

REG_API int reg_kdtree_count(const reg_kdtree *tree) { return tree ? tree->count : 0; }

/* ---- queries ----------------------------------------------------------------------------------------------------- */

/* Squared distances to the boxes of the two children. */
static void regi_kdtree_bounds(const regi_kdtree_node *node, sb_vec3 p, sb_real bound[2])
{
    sb_real gap[3][2];
    for (int c = 0; c < 2; c++) {
        gap[0][c] = sb_max(sb_max(node->low[0][c] - p.x, p.x - node->high[0][c]), 0);
        gap[1][c] = sb_max(sb_max(node->low[1][c] - p.y, p.y - node->high[1][c]), 0);
        gap[2][c] = sb_max(sb_max(node->low[2][c] - p.z, p.z - node->high[2][c]), 0);
    }
    for (int c = 0; c < 2; c++)
        bound[c] = gap[0][c] * gap[0][c] + gap[1][c] * gap[1][c] + gap[2][c] * gap[2][c];
}

/* Squared distances to the points of a leaf; infinity, which is beyond every limit, where there is none. (A NaN would
 * raise the invalid exception in each comparison.) */
static void regi_kdtree_distances(const regi_kdtree_leaf *leaf, sb_vec3 p, sb_real d[REGI_KDTREE_LEAF])
{
    for (int i = 0; i < REGI_KDTREE_LEAF; i++) {
        sb_real x = leaf->x[i] - p.x, y = leaf->y[i] - p.y, z = leaf->z[i] - p.z;
        d[i] = x * x + y * y + z * z;
    }
}

/* What is left to visit. */
typedef struct regi_kdtree_walk {
    sb_real bound[REGI_KDTREE_STACK];
    int node[REGI_KDTREE_STACK];
    int depth;
} regi_kdtree_walk;

static void regi_kdtree_begin(regi_kdtree_walk *walk)
{
    walk->bound[0] = 0;
    walk->node[0] = 1;
    walk->depth = 1;
}

/* The next leaf whose box is at most sqrt(limit) away, nearer ones first, or NULL. */
static const regi_kdtree_leaf *regi_kdtree_next(const reg_kdtree *tree, regi_kdtree_walk *walk, sb_vec3 p,
                                                sb_real limit)
{
    while (walk->depth > 0) {
        int node = walk->node[--walk->depth];
        sb_real bound[2];
        if (walk->bound[walk->depth] > limit)
            continue;
        while (node < tree->leaf_count) {
            int nearer;
            regi_kdtree_bounds(tree->nodes + node, p, bound);
            nearer = bound[1] < bound[0];
            if (bound[!nearer] <= limit) {
                walk->bound[walk->depth] = bound[!nearer];
                walk->node[walk->depth++] = 2 * node + !nearer;
            }
            if (!(bound[nearer] <= limit))
                break;
            node = 2 * node + nearer;
        }
        if (node >= tree->leaf_count)
            return tree->leaves + (node - tree->leaf_count);
    }
    return NULL;
}

/* Square of a radius, or -1 for one that no point can be within; never infinite, so that points too far off to be
 * squared are no answer. */
static sb_real regi_kdtree_limit(sb_real within)
{
    if (!(within >= 0))
        return -1;
    return sbi_capped_product(within, within);
}

REGI_API int regi_kdtree_nearest_from(const reg_kdtree *tree, sb_vec3 point, int found, sb_real *squared)
{
    sb_real best = *squared, d[REGI_KDTREE_LEAF];
    const regi_kdtree_leaf *leaf;
    regi_kdtree_walk walk;
    regi_kdtree_begin(&walk);
    while ((leaf = regi_kdtree_next(tree, &walk, point, best)) != NULL) {
        regi_kdtree_distances(leaf, point, d);
        for (int i = 0; i < REGI_KDTREE_LEAF; i++)
            if (d[i] <= best && (d[i] < best || leaf->index[i] < found)) {
                best = d[i];
                found = leaf->index[i];
            }
    }
    *squared = best;
    return found;
}

REG_API int reg_kdtree_nearest(const reg_kdtree *tree, sb_vec3 point, sb_real within, sb_real *squared)
{
    sb_real best = regi_kdtree_limit(within);
    int found;
    if (!tree || best < 0 || !sb_v3_is_finite(point))
        return -1;
    found = regi_kdtree_nearest_from(tree, point, INT_MAX, &best);
    if (found == INT_MAX)
        return -1;
    if (squared)
        *squared = best;
    return found;
}

static int regi_kdtree_farther(const int *indices, const sb_real *squared, int a, int b)
{
    return squared[a] > squared[b] || (squared[a] == squared[b] && indices[a] > indices[b]);
}

static void regi_kdtree_exchange(int *indices, sb_real *squared, int a, int b)
{
    int index = indices[a];
    sb_real d = squared[a];
    indices[a] = indices[b], indices[b] = index;
    squared[a] = squared[b], squared[b] = d;
}

/* Restores a heap with the farthest on top after entry `at` has become nearer. */
static void regi_kdtree_sink(int *indices, sb_real *squared, int count, int at)
{
    for (;;) {
        int child = 2 * at + 1;
        if (child >= count)
            return;
        if (child + 1 < count && regi_kdtree_farther(indices, squared, child + 1, child))
            child++;
        if (!regi_kdtree_farther(indices, squared, child, at))
            return;
        regi_kdtree_exchange(indices, squared, at, child);
        at = child;
    }
}

static void regi_kdtree_rise(int *indices, sb_real *squared, int at)
{
    for (; at > 0 && regi_kdtree_farther(indices, squared, at, (at - 1) / 2); at = (at - 1) / 2)
        regi_kdtree_exchange(indices, squared, at, (at - 1) / 2);
}

REG_API int reg_kdtree_k_nearest(const reg_kdtree *tree, sb_vec3 point, int k, int *indices, sb_real *squared)
{
    sb_real limit = SB_REAL_MAX, d[REGI_KDTREE_LEAF];
    const regi_kdtree_leaf *leaf;
    regi_kdtree_walk walk;
    int count = 0;
    if (!tree || k < 1 || !indices || !squared || !sb_v3_is_finite(point))
        return 0;
    regi_kdtree_begin(&walk);
    while ((leaf = regi_kdtree_next(tree, &walk, point, limit)) != NULL) {
        regi_kdtree_distances(leaf, point, d);
        for (int i = 0; i < REGI_KDTREE_LEAF; i++) {
            if (!(d[i] <= limit) || (count == k && d[i] == limit && leaf->index[i] > indices[0]))
                continue;
            if (count < k) {
                indices[count] = leaf->index[i];
                squared[count] = d[i];
                regi_kdtree_rise(indices, squared, count++);
            } else {
                indices[0] = leaf->index[i];
                squared[0] = d[i];
                regi_kdtree_sink(indices, squared, count, 0);
            }
            if (count == k)
                limit = squared[0];
        }
    }
    for (int last = count - 1; last > 0; last--) {
        regi_kdtree_exchange(indices, squared, 0, last);
        regi_kdtree_sink(indices, squared, last, 0);
    }
    return count;
}

REG_API int reg_kdtree_within(const reg_kdtree *tree, sb_vec3 point, sb_real radius, int *indices, int room)
{
    sb_real limit = regi_kdtree_limit(radius), d[REGI_KDTREE_LEAF];
    const regi_kdtree_leaf *leaf;
    regi_kdtree_walk walk;
    int count = 0;
    if (!tree || limit < 0 || !sb_v3_is_finite(point))
        return 0;
    regi_kdtree_begin(&walk);
    while ((leaf = regi_kdtree_next(tree, &walk, point, limit)) != NULL) {
        regi_kdtree_distances(leaf, point, d);
        for (int i = 0; i < REGI_KDTREE_LEAF; i++)
            if (d[i] <= limit) {
                if (indices && count < room)
                    indices[count] = leaf->index[i];
                count++;
            }
    }
    return count;
}

/* ==== src/register/cloud.c ==== */
/* cloud: making, normals, thinning, outliers. Files are in cloud_file.c. */


/* ==== making ====================================================================================================== */

REG_API void reg_cloud_free(reg_cloud *cloud)
{
    if (!cloud)
        return;
    sbi_free(&cloud->allocator, cloud->points);
    sbi_free(&cloud->allocator, cloud->normals);
    memset(cloud, 0, sizeof *cloud);
}

REGI_API sb_result regi_cloud_allocate(reg_cloud *cloud, int count, int with_normals, const sb_allocator *allocator,
                                       sb_error *error)
{
    memset(cloud, 0, sizeof *cloud);
    if (allocator)
        cloud->allocator = *allocator;
    cloud->count = count;
    cloud->points = (sb_vec3 *)sbi_alloc(allocator, (size_t)count, sizeof(sb_vec3));
    if (cloud->points && with_normals)
        cloud->normals = (sb_vec3 *)sbi_alloc(allocator, (size_t)count, sizeof(sb_vec3));
    if (cloud->points && (cloud->normals || !with_normals))
        return SB_OK;
    reg_cloud_free(cloud);
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a cloud of %d points", count);
}

/* By its largest entry first, so that squares stay in range. */
REGI_API sb_vec3 regi_cloud_unit(sb_vec3 v)
{
    sb_real size = sb_max(sb_abs(v.x), sb_max(sb_abs(v.y), sb_abs(v.z)));
    if (!(size > 0))
        return sb_v3(0, 0, 0);
    v = sb_v3(v.x / size, v.y / size, v.z / size);
    return sb_v3_scale(1 / sb_v3_norm(v), v);
}

REGI_API sb_result regi_cloud_check(const sb_vec3 *points, const sb_vec3 *normals, int count, sb_error *error)
{
    if (!points || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a cloud needs at least one point, not %d", points ? count : 0);
    for (int i = 0; i < count; i++) {
        if (!sb_v3_is_finite(points[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "point %d has a coordinate that is not finite", i);
        if (normals && !sb_v3_is_finite(normals[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "the normal of point %d is not finite", i);
    }
    return SB_OK;
}

REG_API sb_result reg_cloud_from_points(reg_cloud *cloud, const sb_vec3 *points, const sb_vec3 *normals, int count,
                                        const sb_allocator *allocator, sb_error *error)
{
    sb_result result = regi_cloud_check(points, normals, count, error);
    reg_cloud made;
    if (result != SB_OK)
        return result;
    if (!cloud)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "nowhere to put the cloud");
    result = regi_cloud_allocate(&made, count, normals != NULL, allocator, error);
    if (result != SB_OK)
        return result;
    memcpy(made.points, points, (size_t)count * sizeof points[0]);
    for (int i = 0; normals && i < count; i++)
        made.normals[i] = regi_cloud_unit(normals[i]);
    *cloud = made;
    return SB_OK;
}

/* Twice the area vectors of the triangles around, summed. */
REGI_API void regi_cloud_face_normals(const sbi_surface_cut *cut, sb_vec3 *normals)
{
    const sb_vec3 *x = cut->triangles.nodes;
    for (int i = 0; i < cut->triangles.node_count; i++)
        normals[i] = sb_v3(0, 0, 0);
    for (int t = 0; t < cut->triangles.element_count; t++) {
        const int *c = cut->triangles.elements + 3 * (size_t)t;
        sb_vec3 area = sb_v3_cross(sb_v3_sub(x[c[1]], x[c[0]]), sb_v3_sub(x[c[2]], x[c[0]]));
        for (int k = 0; k < 3; k++)
            normals[c[k]] = sb_v3_add(normals[c[k]], area);
    }
    for (int i = 0; i < cut->triangles.node_count; i++)
        normals[i] = regi_cloud_unit(normals[i]);
}

REG_API sb_result reg_cloud_from_mesh(reg_cloud *cloud, const sb_mesh *mesh, const sb_allocator *allocator,
                                      sb_error *error)
{
    sbi_surface_cut cut;
    reg_cloud made;
    sb_result result;
    if (!cloud || !mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", cloud ? "mesh" : "cloud");
    if (sb_element_dimension(mesh->element_type) == 3)
        return reg_cloud_from_points(cloud, mesh->nodes, NULL, mesh->node_count, allocator, error);
    result = sbi_surface_cut_make(mesh, allocator, &cut, error);
    if (result != SB_OK)
        return result;
    result = regi_cloud_allocate(&made, mesh->node_count, 1, allocator, error);
    if (result == SB_OK) {
        memcpy(made.points, mesh->nodes, (size_t)mesh->node_count * sizeof mesh->nodes[0]);
        regi_cloud_face_normals(&cut, made.normals);
        *cloud = made;
    }
    sbi_surface_cut_free(allocator, &cut);
    return result;
}

/* ==== outliers ==================================================================================================== */

/* Puts what belongs at `middle` there, nothing larger before it; the pivot is drawn, so that no order is slow. */
REGI_API sb_real regi_cloud_select(sb_real *v, int count, int middle)
{
    int low = 0, high = count - 1;
    uint32_t draw = 2463534242u;
    while (low < high) {
        int i = low, j = high;
        sb_real pivot;
        draw ^= draw << 13, draw ^= draw >> 17, draw ^= draw << 5;
        pivot = v[low + (int)(draw % (uint32_t)(high - low + 1))];
        while (i <= j) {
            while (v[i] < pivot)
                i++;
            while (pivot < v[j])
                j--;
            if (i <= j) {
                sb_real t = v[i];
                v[i++] = v[j];
                v[j--] = t;
            }
        }
        if (middle <= j)
            high = j;
        else if (middle >= i)
            low = i;
        else
            break;
    }
    return v[middle];
}

/* Running mean and sum of squares (Welford): exact for equal distances, so that the rule keeps them all. */
static sb_real regi_outlier_deviation(const sb_real *d, int count, sb_real parameter)
{
    sb_real mean = 0, squares = 0;
    for (int i = 0; i < count; i++) {
        sb_real step = d[i] - mean;
        mean += step / (sb_real)(i + 1);
        squares += step * (d[i] - mean);
    }
    return mean + parameter * sb_sqrt(sb_max(squares, 0) / (sb_real)count);
}

static sb_real regi_outlier_median(sb_real *d, int count, sb_real parameter)
{
    sb_real median = regi_cloud_select(d, count, (count - 1) / 2);
    for (int i = 0; i < count; i++)
        d[i] = sb_abs(d[i] - median);
    return median + parameter * (sb_real)1.4826 * regi_cloud_select(d, count, (count - 1) / 2);
}

REG_API sb_real reg_outlier_limit(const sb_real *distances, int count, reg_outliers rule, sb_real parameter,
                                  sb_real *scratch)
{
    int n = 0, kept;
    if (rule == REG_OUTLIERS_NONE)
        return SB_REAL_MAX;
    if (!distances || !scratch || !(parameter >= 0) || !sb_is_finite(parameter))
        return -1;
    for (int i = 0; i < count; i++)
        if (sb_is_finite(distances[i]))
            scratch[n++] = distances[i];
    if (n < 1)
        return -1;
    switch (rule) {
    case REG_OUTLIERS_DEVIATION: return regi_outlier_deviation(scratch, n, parameter);
    case REG_OUTLIERS_MEDIAN: return regi_outlier_median(scratch, n, parameter);
    case REG_OUTLIERS_TRIM:
        if (!(parameter > 0) || parameter > 1)
            return -1;
        kept = (int)(parameter * (sb_real)n + (sb_real)0.5);
        return regi_cloud_select(scratch, n, sbi_min_int(sbi_max_int(kept, 1), n) - 1);
    case REG_OUTLIERS_NONE: break;
    }
    return -1;
}

/* Mean distance of every point to its k nearest, itself left out; in the tree's order. */
static sb_result regi_cloud_spacing(const reg_cloud *cloud, const reg_kdtree *tree, int k, sb_real *spacing,
                                    sb_error *error)
{
    const sb_allocator *allocator = &cloud->allocator;
    size_t row = (size_t)k + 1;
    int *order = (int *)sbi_alloc(allocator, (size_t)cloud->count + row, sizeof(int));
    sb_real *squared = (sb_real *)sbi_alloc(allocator, row, sizeof(sb_real));
    sb_result result = order && squared ? SB_OK : sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d neighbours", k);
    if (result == SB_OK) {
        regi_kdtree_order(tree, order);
        for (int i = 0; i < cloud->count; i++) {
            int at = order[i], *nearest = order + cloud->count;
            int found = reg_kdtree_k_nearest(tree, cloud->points[at], k + 1, nearest, squared);
            sb_real sum = 0;
            for (int j = 1; j < found; j++) /* at 0 is the point itself or one in the same place */
                sum += sb_sqrt(squared[j]);
            spacing[at] = found > 1 ? sum / (sb_real)(found - 1) : 0;
        }
    }
    sbi_free(allocator, order);
    sbi_free(allocator, squared);
    return result;
}

/* Keeps the points whose value is at most the limit, in place; returns how many. The arrays keep their size. */
static int regi_cloud_keep(reg_cloud *cloud, const sb_real *value, sb_real limit)
{
    int kept = 0;
    for (int i = 0; i < cloud->count; i++) {
        if (value[i] > limit)
            continue;
        cloud->points[kept] = cloud->points[i];
        if (cloud->normals)
            cloud->normals[kept] = cloud->normals[i];
        kept++;
    }
    return kept;
}

REG_API sb_result reg_cloud_remove_outliers(reg_cloud *cloud, int k, reg_outliers rule, sb_real parameter, int *removed,
                                            sb_error *error)
{
    reg_kdtree *tree = NULL;
    sb_real *spacing, limit = 0;
    sb_result result;
    int kept;
    if (!cloud || k < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s", cloud ? "at least one neighbour is needed" : "cloud is NULL");
    result = reg_kdtree_create(cloud->points, cloud->count, &cloud->allocator, &tree, error);
    if (result != SB_OK)
        return result;
    k = sbi_min_int(k, cloud->count);
    spacing = (sb_real *)sbi_alloc(&cloud->allocator, (size_t)cloud->count, 2 * sizeof(sb_real));
    result = spacing ? regi_cloud_spacing(cloud, tree, k, spacing, error)
                     : sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d distances", cloud->count);
    if (result == SB_OK) {
        limit = reg_outlier_limit(spacing, cloud->count, rule, parameter, spacing + cloud->count);
        if (limit < 0)
            result = sbi_fail(error, SB_ERROR_ARGUMENT, "outlier rule %d with the parameter %g is out of range",
                              (int)rule, (double)parameter);
    }
    if (result == SB_OK) {
        kept = regi_cloud_keep(cloud, spacing, limit);
        if (removed)
            *removed = cloud->count - kept;
        cloud->count = kept;
    }
    sbi_free(&cloud->allocator, spacing);
    reg_kdtree_destroy(tree);
    return result;
}

/* ==== thinning ==================================================================================================== */

/* Cubes met so far, in a table of open addresses. */
typedef struct regi_cloud_cubes {
    double (*key)[3]; /* [count]: which cube; whole numbers */
    int *points;      /* [count]: how many it holds */
    int *slot;        /* [mask + 1]: index of a cube, or -1 */
    size_t mask;
    int count;
} regi_cloud_cubes;

static size_t regi_cloud_hash(const double key[3])
{
    uint64_t hash = 1469598103934665603u;
    for (int a = 0; a < 3; a++) {
        hash = (hash ^ sbi_dense_bits(key[a] + 0.0)) * 0x9E3779B97F4A7C15u; /* + 0.0: no negative zeros */
        hash ^= hash >> 32;
    }
    return (size_t)hash;
}

/* The cube of a point, made when it is new. */
static int regi_cloud_cube(regi_cloud_cubes *cubes, sb_vec3 point, double size)
{
    double key[3];
    size_t at;
    key[0] = floor((double)point.x / size);
    key[1] = floor((double)point.y / size);
    key[2] = floor((double)point.z / size);
    for (at = regi_cloud_hash(key) & cubes->mask; cubes->slot[at] >= 0; at = (at + 1) & cubes->mask) {
        const double *other = cubes->key[cubes->slot[at]];
        if (other[0] <= key[0] && other[0] >= key[0] && other[1] <= key[1] && other[1] >= key[1] &&
            other[2] <= key[2] && other[2] >= key[2])
            return cubes->slot[at];
    }
    memcpy(cubes->key[cubes->count], key, sizeof key);
    cubes->points[cubes->count] = 0;
    return cubes->slot[at] = cubes->count++;
}

/* Means as they grow: near the points, so that nothing is lost far from the origin. */
static void regi_cloud_gather(const reg_cloud *cloud, sb_real size, regi_cloud_cubes *cubes, reg_cloud *thin)
{
    for (int i = 0; i < cloud->count; i++) {
        int c = regi_cloud_cube(cubes, cloud->points[i], (double)size), n = ++cubes->points[c];
        sb_vec3 mean = n > 1 ? thin->points[c] : cloud->points[i];
        thin->points[c] = sb_v3_madd(mean, 1 / (sb_real)n, sb_v3_sub(cloud->points[i], mean));
        if (cloud->normals)
            thin->normals[c] = n > 1 ? sb_v3_add(thin->normals[c], cloud->normals[i]) : cloud->normals[i];
    }
    for (int c = 0; cloud->normals && c < cubes->count; c++)
        thin->normals[c] = regi_cloud_unit(thin->normals[c]);
}

REG_API sb_result reg_cloud_thin(const reg_cloud *cloud, sb_real size, reg_cloud *thin, sb_error *error)
{
    regi_cloud_cubes cubes;
    reg_cloud gathered, made;
    sb_allocator allocator;
    sb_result result;
    if (!cloud || !thin || !(size > 0) || !sb_is_finite(size))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "thinning needs a cloud and a positive size, not %g", (double)size);
    result = regi_cloud_check(cloud->points, cloud->normals, cloud->count, error);
    if (result != SB_OK)
        return result;
    allocator = cloud->allocator;
    memset(&cubes, 0, sizeof cubes);
    memset(&made, 0, sizeof made);
    for (cubes.mask = 7; cubes.mask / 2 < (size_t)cloud->count; cubes.mask = 2 * cubes.mask + 1)
        continue;
    result = regi_cloud_allocate(&gathered, cloud->count, cloud->normals != NULL, &allocator, error);
    if (result != SB_OK)
        return result;
    cubes.key = (double(*)[3])sbi_alloc(&allocator, (size_t)cloud->count, sizeof cubes.key[0]);
    cubes.points = (int *)sbi_alloc(&allocator, (size_t)cloud->count, sizeof(int));
    cubes.slot = (int *)sbi_alloc(&allocator, cubes.mask + 1, sizeof(int));
    if (cubes.key && cubes.points && cubes.slot) {
        memset(cubes.slot, -1, (cubes.mask + 1) * sizeof(int));
        regi_cloud_gather(cloud, size, &cubes, &gathered);
        result = regi_cloud_allocate(&made, cubes.count, cloud->normals != NULL, &allocator, error);
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory to thin %d points", cloud->count);
    }
    sbi_free(&allocator, cubes.key);
    sbi_free(&allocator, cubes.points);
    sbi_free(&allocator, cubes.slot);
    if (result == SB_OK) {
        memcpy(made.points, gathered.points, (size_t)made.count * sizeof(sb_vec3));
        if (made.normals)
            memcpy(made.normals, gathered.normals, (size_t)made.count * sizeof(sb_vec3));
        if (thin == cloud)
            reg_cloud_free(thin);
        *thin = made;
    }
    reg_cloud_free(&gathered);
    return result;
}

REG_API int reg_cloud_spread(const sb_vec3 *points, int count, int wanted, int *chosen, sb_real *scratch)
{
    sb_vec3 last = sb_v3(0, 0, 0);
    int n = 0;
    if (!points || !chosen || !scratch || count < 1)
        return 0;
    for (int i = 0; i < count; i++)
        last = sb_v3_madd(last, 1 / (sb_real)(i + 1), sb_v3_sub(points[i], last));
    for (int i = 0; i < count; i++)
        scratch[i] = SB_REAL_MAX;
    while (n < wanted && n < count) {
        sb_real most = -1;
        int best = 0;
        for (int i = 0; i < count; i++) {
            sb_vec3 d = sb_v3_sub(points[i], last);
            sb_real square = sb_min(scratch[i], sb_v3_dot(d, d));
            scratch[i] = square;
            if (square > most) {
                most = square;
                best = i;
            }
        }
        if (n > 0 && !(most > 0))
            break;
        if (n == 0) /* the mean is no point: from now on distances are to chosen ones */
            for (int i = 0; i < count; i++)
                scratch[i] = SB_REAL_MAX;
        chosen[n++] = best;
        last = points[best];
    }
    return n;
}

/* ==== normals ===================================================================================================== */

/* The fits, in blocks of points that are neighbours. */
enum { REGI_CLOUD_BLOCK = 1024 };
typedef struct regi_cloud_fits {
    const sb_vec3 *points;
    const reg_kdtree *tree;
    const int *order;
    int *neighbours;  /* [count][k], in the order of the points; the first is the point itself */
    sb_real *squared; /* [count][k] */
    sb_vec3 *normals;
    int count, k;
} regi_cloud_fits;

/* Across the plane of least squares; 0 where the points spread in fewer than two directions. */
static sb_vec3 regi_cloud_fit(const sb_vec3 *points, const int *neighbours, int count)
{
    sb_vec3 mean = sb_v3(0, 0, 0), values;
    sb_mat3 spread = sb_m3_zero(), vectors;
    for (int i = 0; i < count; i++)
        mean = sb_v3_madd(mean, 1 / (sb_real)(i + 1), sb_v3_sub(points[neighbours[i]], mean));
    for (int i = 0; i < count; i++) {
        sb_vec3 d = sb_v3_sub(points[neighbours[i]], mean);
        spread = sb_m3_add(spread, sb_m3_outer(d, d));
    }
    sb_m3_eigen(spread, &values, &vectors);
    return values.y > 64 * SB_EPSILON * values.x ? sb_m3_column(vectors, 2) : sb_v3(0, 0, 0);
}

static void regi_cloud_fit_block(void *user, int block)
{
    const regi_cloud_fits *fits = (const regi_cloud_fits *)user;
    int end = sbi_min_int(fits->count - block * REGI_CLOUD_BLOCK, REGI_CLOUD_BLOCK);
    for (int i = 0; i < end; i++) {
        int at = fits->order[block * REGI_CLOUD_BLOCK + i];
        size_t row = (size_t)at * (size_t)fits->k;
        reg_kdtree_k_nearest(fits->tree, fits->points[at], fits->k, fits->neighbours + row, fits->squared + row);
        fits->normals[at] = regi_cloud_fit(fits->points, fits->neighbours + row, fits->k);
    }
}

/* A heap of the points next to those whose normals are settled, the most parallel one on top. */
typedef struct regi_cloud_front {
    const regi_cloud_fits *fits;
    sb_real *key;      /* [count]: 1 - |cosine| to the settled neighbour */
    int *from;         /* [count]: that neighbour */
    int *heap, *place; /* [count]: place -1: not met, -2: settled */
    int count;
} regi_cloud_front;

static int regi_cloud_before(const regi_cloud_front *front, int a, int b)
{
    return front->key[a] < front->key[b] || (front->key[a] <= front->key[b] && a < b);
}

static void regi_cloud_put(regi_cloud_front *front, int at, int point)
{
    front->heap[at] = point;
    front->place[point] = at;
}

static void regi_cloud_rise(regi_cloud_front *front, int at)
{
    int point = front->heap[at];
    for (; at > 0 && regi_cloud_before(front, point, front->heap[(at - 1) / 2]); at = (at - 1) / 2)
        regi_cloud_put(front, at, front->heap[(at - 1) / 2]);
    regi_cloud_put(front, at, point);
}

static int regi_cloud_pop(regi_cloud_front *front)
{
    int top = front->heap[0], last = front->heap[--front->count], at = 0;
    for (;;) {
        int child = 2 * at + 1;
        if (child + 1 < front->count && regi_cloud_before(front, front->heap[child + 1], front->heap[child]))
            child++;
        if (child >= front->count || !regi_cloud_before(front, front->heap[child], last))
            break;
        regi_cloud_put(front, at, front->heap[child]);
        at = child;
    }
    if (front->count > 0)
        regi_cloud_put(front, at, last);
    return top;
}

/* Settles a point and offers its neighbours. */
static void regi_cloud_settle(regi_cloud_front *front, int point)
{
    const regi_cloud_fits *fits = front->fits;
    const int *neighbours = fits->neighbours + (size_t)point * (size_t)fits->k;
    front->place[point] = -2;
    for (int i = 0; i < fits->k; i++) {
        int next = neighbours[i];
        sb_real key = 1 - sb_abs(sb_v3_dot(fits->normals[point], fits->normals[next]));
        if (front->place[next] == -2 || (front->place[next] >= 0 && !(key < front->key[next])))
            continue;
        front->key[next] = key;
        front->from[next] = point;
        if (front->place[next] < 0)
            regi_cloud_put(front, front->count++, next);
        regi_cloud_rise(front, front->place[next]);
    }
}

/* A point that nothing led to: it follows a neighbour that is settled, since being a neighbour is not mutual, else it
 * looks up. */
static void regi_cloud_seed(regi_cloud_front *front, int point)
{
    const regi_cloud_fits *fits = front->fits;
    const int *neighbours = fits->neighbours + (size_t)point * (size_t)fits->k;
    sb_vec3 guide = sb_v3(0, 0, 1);
    for (int i = 0; i < fits->k; i++)
        if (front->place[neighbours[i]] == -2) {
            guide = fits->normals[neighbours[i]];
            break;
        }
    if (sb_v3_dot(guide, fits->normals[point]) < 0)
        fits->normals[point] = sb_v3_scale(-1, fits->normals[point]);
    regi_cloud_settle(front, point);
}

static int regi_cloud_higher(const void *context, int a, int b)
{
    const sb_vec3 *points = (const sb_vec3 *)context;
    return points[a].z > points[b].z;
}

static sb_result regi_cloud_agree(const regi_cloud_fits *fits, const sb_allocator *allocator, sb_error *error)
{
    size_t n = (size_t)fits->count;
    int *memory = (int *)sbi_alloc(allocator, n, 5 * sizeof(int));
    regi_cloud_front front;
    front.key = (sb_real *)sbi_alloc(allocator, n, sizeof(sb_real));
    if (memory && front.key) {
        int *seeds = memory, *scratch = memory + n;
        front.fits = fits;
        front.from = memory + 2 * n;
        front.heap = memory + 3 * n;
        front.place = memory + 4 * n;
        front.count = 0;
        for (int i = 0; i < fits->count; i++) {
            seeds[i] = i;
            front.place[i] = -1;
        }
        sbi_merge_sort(seeds, scratch, fits->count, regi_cloud_higher, fits->points);
        for (int i = 0; i < fits->count; i++) {
            if (front.place[seeds[i]] == -2)
                continue;
            regi_cloud_seed(&front, seeds[i]);
            while (front.count > 0) {
                int point = regi_cloud_pop(&front);
                if (sb_v3_dot(fits->normals[point], fits->normals[front.from[point]]) < 0)
                    fits->normals[point] = sb_v3_scale(-1, fits->normals[point]);
                regi_cloud_settle(&front, point);
            }
        }
    }
    sbi_free(allocator, front.key);
    sbi_free(allocator, memory);
    return memory && front.key ? SB_OK : sbi_fail(error, SB_ERROR_MEMORY, "no memory to orient the normals");
}

static void regi_cloud_face(const regi_cloud_fits *fits, sb_vec3 view)
{
    for (int i = 0; i < fits->count; i++)
        if (sb_v3_dot(fits->normals[i], sb_v3_sub(view, fits->points[i])) < 0)
            fits->normals[i] = sb_v3_scale(-1, fits->normals[i]);
}

REG_API sb_result reg_cloud_estimate_normals(reg_cloud *cloud, int k, const sb_vec3 *view, const sb_jobs *jobs,
                                             sb_error *error)
{
    regi_cloud_fits fits;
    const sb_allocator *allocator;
    reg_kdtree *tree = NULL;
    int *order;
    sb_result result;
    if (!cloud || k < 3)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "normals need a cloud and at least 3 neighbours, not %d", k);
    if (view && !sb_v3_is_finite(*view))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the view point is not finite");
    allocator = &cloud->allocator;
    result = reg_kdtree_create(cloud->points, cloud->count, allocator, &tree, error);
    if (result != SB_OK)
        return result;
    fits.points = cloud->points;
    fits.tree = tree;
    fits.count = cloud->count;
    fits.k = k < cloud->count ? k + 1 : cloud->count;
    fits.order = order = (int *)sbi_alloc(allocator, (size_t)cloud->count, sizeof(int));
    fits.neighbours = (int *)sbi_alloc(allocator, (size_t)cloud->count, (size_t)fits.k * sizeof(int));
    fits.squared = (sb_real *)sbi_alloc(allocator, (size_t)cloud->count, (size_t)fits.k * sizeof(sb_real));
    fits.normals = (sb_vec3 *)sbi_alloc(allocator, (size_t)cloud->count, sizeof(sb_vec3));
    if (order && fits.neighbours && fits.squared && fits.normals) {
        regi_kdtree_order(tree, order);
        sbi_run(jobs, regi_cloud_fit_block, &fits, (cloud->count - 1) / REGI_CLOUD_BLOCK + 1);
        if (view)
            regi_cloud_face(&fits, *view);
        else
            result = regi_cloud_agree(&fits, allocator, error);
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the normals of %d points", cloud->count);
    }
    if (result == SB_OK) {
        sbi_free(allocator, cloud->normals);
        cloud->normals = fits.normals;
        fits.normals = NULL;
    }
    sbi_free(allocator, order);
    sbi_free(allocator, fits.neighbours);
    sbi_free(allocator, fits.squared);
    sbi_free(allocator, fits.normals);
    reg_kdtree_destroy(tree);
    return result;
}

/* ==== src/register/cloud_file.c ==== */
/* cloud_file: reading and writing clouds, on the readers of meshes. Part of the room cloud. */


#include <limits.h>

/* ==== text ======================================================================================================== */

/* A text of points that is being read. */
typedef struct regi_xyz {
    sbi_loader *loader;
    char decimal;                /* the mark that fractions between semicolons have: '.', ',' or 0, not known yet */
    int declared, declared_line; /* the number of points that the first line gives; -1: it gives none */
} regi_xyz;

/* 1 when the line has a semicolon: then commas are decimal marks. */
static int regi_xyz_has_semicolon(const sbi_reader *reader)
{
    for (size_t at = reader->at; at < reader->size && !strchr("\n\r#", reader->data[at]); at++)
        if (reader->data[at] == ';')
            return 1;
    return 0;
}

/* The next field of the line, which may be empty between two separators; 0 at the end. *separator: what is before it:
 * 0 on the first call of a line, else a semicolon, a comma or, for nothing but blanks, a blank. */
static int regi_xyz_field(sbi_reader *reader, int semicolons, sbi_word *field, char *separator)
{
    const char *marks = semicolons ? ";" : ",";
    int is_first = *separator == 0;
    if (sbi_reader_at_line_end(reader))
        return 0;
    if (!is_first) {
        *separator = reader->data[reader->at] == marks[0] ? marks[0] : ' ';
        reader->at += *separator == marks[0];
        if (sbi_reader_at_line_end(reader))
            return 0;
    } else {
        *separator = ' ';
    }
    field->text = reader->data + reader->at;
    if (sbi_reader_left(reader) > 1 && memcmp(field->text, "//", 2) == 0)
        return 0;
    while (reader->at < reader->size && !strchr(" \t\v\f\r\n#", reader->data[reader->at]) &&
           reader->data[reader->at] != marks[0])
        reader->at++;
    field->length = (size_t)(reader->data + reader->at - field->text);
    return 1;
}

/* Whether a field is meant as a number. */
static int regi_xyz_like_number(sbi_word field)
{
    double value;
    size_t i = 0;
    while (i < field.length && i < 2 && strchr("+-.,", field.text[i]))
        i++;
    return (i < field.length && field.text[i] >= '0' && field.text[i] <= '9') ||
           sbi_parse_real(field.text, field.length, &value) != 0;
}

/* As sbi_parse_real, with a decimal comma between semicolons; -2: both marks in one file. */
static int regi_xyz_number(regi_xyz *xyz, sbi_word field, int semicolons, double *value)
{
    char text[64];
    const char *comma = (const char *)memchr(field.text, ',', field.length);
    int parsed;
    if (!comma || field.length >= sizeof text) {
        parsed = sbi_parse_real(field.text, field.length, value);
    } else {
        memcpy(text, field.text, field.length);
        text[comma - field.text] = '.';
        parsed = sbi_parse_real(text, field.length, value);
    }
    if (parsed > 0 && semicolons && (comma || memchr(field.text, '.', field.length))) {
        char mark = comma ? ',' : '.';
        if (xyz->decimal && xyz->decimal != mark)
            return -2;
        xyz->decimal = mark;
    }
    return parsed;
}

static sb_result regi_xyz_fail_field(const sbi_reader *reader, sbi_word field, int parsed)
{
    char text[32];
    if (parsed == -2)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s': decimal points and decimal commas in one file",
                               sbi_word_print(field, text));
    if (parsed < 0)
        return sbi_reader_fail(reader, SB_ERROR_NOT_FINITE, "'%s' is not finite", sbi_word_print(field, text));
    if (field.length == 0)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "nothing between two separators where a number should be");
    return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s' is not a number", sbi_word_print(field, text));
}

/* `0,05,1,5`, `0,5 0,25 1,5`: columns, or decimal commas? Nobody can know. */
static int regi_xyz_is_ambiguous(sbi_word field, char separator, char first_separator)
{
    size_t sign = field.length > 0 && (field.text[0] == '-' || field.text[0] == '+') ? 1 : 0;
    if (separator != first_separator)
        return 1;
    return separator == ',' && field.length > sign + 1 && field.text[sign] == '0' && field.text[sign + 1] >= '0' &&
           field.text[sign + 1] <= '9';
}

/* The first up to six numbers of the line; a field behind the third that is none ends them. */
static sb_result regi_xyz_line(regi_xyz *xyz, double x[6], int *count)
{
    sbi_reader *reader = &xyz->loader->reader;
    int semicolons = regi_xyz_has_semicolon(reader);
    char separator = 0, first_separator = 0;
    sbi_word field;
    *count = 0;
    while (*count < 6 && regi_xyz_field(reader, semicolons, &field, &separator)) {
        int parsed = regi_xyz_number(xyz, field, semicolons, x + *count);
        if (parsed == 0 && *count >= 3)
            break;
        if (parsed <= 0)
            return regi_xyz_fail_field(reader, field, parsed);
        if (*count == 1)
            first_separator = separator;
        if (*count >= 1 && regi_xyz_is_ambiguous(field, separator, first_separator))
            return sbi_reader_fail(reader, SB_ERROR_FORMAT,
                                   "are the commas between columns, or in numbers? Write decimal points, or semicolons "
                                   "between the columns");
        ++*count;
    }
    return SB_OK;
}

/* Columns four to six are a normal when that of the first point has about unit length: colours have not. */
static int regi_xyz_has_normals(const double x[6], int count)
{
    double squared = x[3] * x[3] + x[4] * x[4] + x[5] * x[5];
    return count == 6 && squared > 0.25 && squared < 4;
}

/* 1 for a first line that is a heading, or holds nothing but the number of points, which is noted. */
static int regi_xyz_is_heading(regi_xyz *xyz)
{
    sbi_reader ahead = xyz->loader->reader;
    int semicolons = regi_xyz_has_semicolon(&ahead), fields = 0, numbers = 0;
    char separator = 0;
    sbi_word field, first = {NULL, 0};
    int64_t declared;
    while (regi_xyz_field(&ahead, semicolons, &field, &separator)) {
        if (fields++ == 0)
            first = field;
        numbers += regi_xyz_like_number(field);
    }
    if (numbers == 0)
        return 1;
    if (fields != 1 || sbi_parse_integer(first.text, first.length, &declared) <= 0 || declared < 0 ||
        declared > INT_MAX)
        return 0;
    xyz->declared = (int)declared;
    xyz->declared_line = xyz->loader->reader.line;
    return 1;
}

static int regi_xyz_is_empty(const sbi_reader *reader)
{
    sbi_reader ahead = *reader;
    char separator = 0;
    sbi_word field;
    return !regi_xyz_field(&ahead, regi_xyz_has_semicolon(reader), &field, &separator);
}

/* A point, and its normal where the first one has one. */
static sb_result regi_xyz_point(regi_xyz *xyz, int *with_normals)
{
    sbi_loader *loader = xyz->loader;
    int count;
    double x[6];
    sb_result result = regi_xyz_line(xyz, x, &count);
    if (!result && count < 3)
        result = sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "a point needs three numbers, here are %d", count);
    if (!result && loader->node_count == 0)
        *with_normals = regi_xyz_has_normals(x, count);
    if (!result && *with_normals && count < 6)
        result = sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "a point without the normal that the first one has");
    if (!result)
        result = sbi_loader_add_node(loader, x);
    if (!result && *with_normals)
        result = sbi_loader_add_normal(loader, x + 3);
    return result;
}

static sb_result regi_xyz_read(sbi_loader *loader)
{
    sbi_reader *reader = &loader->reader;
    sb_result result = sbi_reader_check_kind(reader);
    int with_normals = 0, is_first = 1;
    regi_xyz xyz;
    xyz.loader = loader;
    xyz.decimal = 0;
    xyz.declared = -1;
    xyz.declared_line = 0;
    reader->comment = '#';
    if (!result)
        result = sbi_reader_check_text(reader);
    for (; reader->at < reader->size && !result; sbi_reader_next_line(reader)) {
        if (regi_xyz_is_empty(reader))
            continue;
        reader->node = (int)loader->node_count;
        if (!is_first || !regi_xyz_is_heading(&xyz))
            result = regi_xyz_point(&xyz, &with_normals);
        is_first = 0;
    }
    reader->node = -1;
    if (!result && xyz.declared >= 0 && (size_t)xyz.declared != loader->node_count) {
        reader->line = xyz.declared_line;
        result = sbi_reader_fail(reader, SB_ERROR_FORMAT, "the first line says %d points, there are %lu", xyz.declared,
                                 (unsigned long)loader->node_count);
    }
    return result;
}

/* ==== loading ===================================================================================================== */

/* Endings that only texts of points have. */
static int regi_cloud_named_text(const char *name)
{
    static const char endings[6][6] = {".xyz", ".txt", ".csv", ".asc", ".pts", ".xyzn"};
    size_t length = strlen(name);
    for (int i = 0; i < 6; i++) {
        sbi_word word;
        word.length = strlen(endings[i]);
        word.text = name + length - word.length;
        if (length >= word.length && sbi_word_is(word, endings[i]))
            return 1;
    }
    return 0;
}

/* A text of points has no mark: it is what no mesh format claims. */
static sb_result regi_cloud_parse(sbi_loader *loader, reg_cloud_format format)
{
    sb_file_format mesh = format == REG_CLOUD_PLY ? SB_FILE_PLY : SB_FILE_AUTO;
    sbi_reader quiet = loader->reader;
    sbi_word word;
    quiet.error = NULL;
    if (loader->reader.size == 0)
        return sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "the file is empty");
    if (format == REG_CLOUD_AUTO && sbi_reader_peek(&quiet, &word) && sbi_word_is(word, "ply"))
        mesh = SB_FILE_PLY;
    else if (format == REG_CLOUD_AUTO && regi_cloud_named_text(loader->reader.name))
        format = REG_CLOUD_XYZ;
    else if (format == REG_CLOUD_AUTO && sbi_file_detect(&quiet, &mesh) == SB_ERROR_FORMAT)
        format = REG_CLOUD_XYZ;
    if (format == REG_CLOUD_XYZ)
        return regi_xyz_read(loader);
    if (mesh == SB_FILE_AUTO) {
        sb_result result = sbi_file_detect(&loader->reader, &mesh);
        if (result != SB_OK)
            return result;
    }
    return sbi_loader_parse(loader, mesh);
}

static sb_result regi_cloud_read(sbi_loader *loader, reg_cloud_format format, reg_cloud *cloud)
{
    sb_result result;
    loader->points_only = 1;
    result = regi_cloud_parse(loader, format);
    if (!result && loader->node_count == 0)
        result = sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "the file has no points");
    if (result)
        return result;
    memset(cloud, 0, sizeof *cloud);
    cloud->allocator = loader->allocator;
    cloud->count = (int)loader->node_count;
    cloud->points = loader->nodes;
    loader->nodes = NULL;
    if (loader->normal_count == loader->node_count) {
        cloud->normals = loader->normals;
        loader->normals = NULL;
        for (int i = 0; i < cloud->count; i++)
            cloud->normals[i] = regi_cloud_unit(cloud->normals[i]);
    }
    return SB_OK;
}

static sb_result regi_cloud_begin(sbi_loader *loader, const void *cloud, sb_real scale, const sb_allocator *allocator,
                                  sb_error *error)
{
    sb_load_options options = sb_default_load_options();
    if (!cloud)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "cloud is NULL");
    if (!(scale > 0) || !sb_is_finite(scale))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the scale is %g, it must be positive", (double)scale);
    options.scale = scale;
    if (allocator)
        options.allocator = *allocator;
    sbi_loader_init(loader, &options, error);
    return SB_OK;
}

REG_API sb_result reg_cloud_load_memory(reg_cloud *cloud, const void *data, size_t size, reg_cloud_format format,
                                        const char *name, sb_real scale, const sb_allocator *allocator, sb_error *error)
{
    sbi_loader loader;
    sb_result result = regi_cloud_begin(&loader, cloud, scale, allocator, error);
    if (result)
        return result;
    if (!data && size)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "data is NULL");
    if ((int)format < REG_CLOUD_AUTO || (int)format > REG_CLOUD_MESH)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d is not a format of clouds", (int)format);
    sbi_loader_set_content(&loader, size ? (const char *)data : "", size, name);
    result = regi_cloud_read(&loader, format, cloud);
    sbi_loader_free(&loader);
    return result;
}

REG_API sb_result reg_cloud_load(reg_cloud *cloud, const char *path, sb_real scale, const sb_allocator *allocator,
                                 sb_error *error)
{
    sbi_loader loader;
    sbi_file content;
    sb_result result = regi_cloud_begin(&loader, cloud, scale, allocator, error);
    if (result)
        return result;
    if (!path)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "path is NULL");
    result = sbi_file_read(&loader.allocator, path, &content, error);
    if (!result) {
        sbi_loader_set_content(&loader, content.data, content.size, path);
        result = regi_cloud_read(&loader, REG_CLOUD_AUTO, cloud);
    }
    sbi_free(&loader.allocator, content.data);
    sbi_loader_free(&loader);
    return result;
}

/* ==== writing ===================================================================================================== */

static void regi_cloud_write_vector(sbi_export *out, sb_vec3 v, const char *after)
{
    sb_real x[3];
    x[0] = v.x, x[1] = v.y, x[2] = v.z;
    for (int i = 0; i < 3; i++) {
        if (out->binary) {
            sbi_export_bits(out, sbi_export_real_bits(x[i]), (int)sizeof(sb_real), 0);
            continue;
        }
        sbi_export_print_real(out, x[i]);
        sbi_export_text(out, i < 2 ? " " : after);
    }
}

static void regi_cloud_write_header(sbi_export *out, const reg_cloud *cloud)
{
    static const char names[6][3] = {"x", "y", "z", "nx", "ny", "nz"};
    char line[64];
    sbi_export_text(out, out->binary ? "ply\nformat binary_little_endian 1.0\n" : "ply\nformat ascii 1.0\n");
    snprintf(line, sizeof line, "comment unit: metre\nelement vertex %d\n", cloud->count);
    sbi_export_text(out, line);
    for (int i = 0; i < (cloud->normals ? 6 : 3); i++) {
        snprintf(line, sizeof line, "property %s %s\n", SB_REAL_IS_FLOAT ? "float" : "double", names[i]);
        sbi_export_text(out, line);
    }
    sbi_export_text(out, "end_header\n");
}

REG_API sb_result reg_cloud_save_ply(const char *path, const reg_cloud *cloud, int ascii, sb_error *error)
{
    sbi_export out;
    sb_result result;
    if (!path || !cloud)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", path ? "cloud" : "path");
    result = regi_cloud_check(cloud->points, cloud->normals, cloud->count, error);
    if (!result)
        result = sbi_export_open(&out, path, !ascii, error);
    if (result)
        return result;
    regi_cloud_write_header(&out, cloud);
    for (int i = 0; i < cloud->count; i++) {
        regi_cloud_write_vector(&out, cloud->points[i], cloud->normals ? " " : "\n");
        if (cloud->normals)
            regi_cloud_write_vector(&out, cloud->normals[i], "\n");
    }
    return sbi_export_close(&out, error);
}

/* ==== src/register/cloud_smooth.c ==== */
/* cloud_smooth: noise and outliers of what was seen, by local fits. */
#include <string.h>


enum {
    REGI_SMOOTH_LEAST = 16,  /* neighbours of the smallest fit */
    REGI_SMOOTH_NEXT = 6,    /* those whose distance is a point's spacing */
    REGI_SMOOTH_MOST = 128,  /* and of the largest; each has twice those of the one before */
    REGI_SMOOTH_ASKED = 192, /* among which they are */
    REGI_SMOOTH_TERMS = 6,   /* 1 x y x^2 xy y^2 */
    REGI_SMOOTH_ROUNDS = 3,
    REGI_SMOOTH_BLOCK = 256 /* points per task */
};

/* What the passes over the points share. */
typedef struct regi_smooth {
    const sb_vec3 *points, *normals; /* [count]; normals NULL, or 0 where unknown */
    const reg_kdtree *tree;
    int count;
    const unsigned char *out; /* [count] 1: outliers, which no fit takes */
    sb_real noise, usual;     /* m; that of the points, and their spacing */
    sb_real *residual;        /* [count] distance from what the neighbours say, over its expected share */
    sb_real *share;           /* [count] that share: of a residual, or of what smoothing leaves, in noises */
    sb_real *scatter;         /* [count] of the neighbours about their own surface: median (m) */
    sb_real *spacing;         /* [count] mean distance to the neighbours (m) */
    sb_vec3 *moved, *facing;  /* [count] smoothed points, and the normals there */
} regi_smooth;

/* Height over a plane through a point, in a frame of its own. */
typedef struct regi_smooth_frame {
    sb_vec3 at, x, y, z;
    sb_real scale; /* m: of the neighbourhood */
} regi_smooth_frame;

/* Normal equations of heights as a quadratic of the place in the plane. */
typedef struct regi_smooth_sums {
    sb_real matrix[REGI_SMOOTH_TERMS * REGI_SMOOTH_TERMS], right[REGI_SMOOTH_TERMS];
} regi_smooth_sums;

/* The nearest points that may be used to place a point: no outliers, not of a surface that faces the other way. */
static int regi_smooth_neighbours(const regi_smooth *s, int point, int with_itself, int wanted, int *near)
{
    int found[REGI_SMOOTH_ASKED], asked = sbi_min_int(2 * wanted, REGI_SMOOTH_ASKED), count, kept = 0;
    sb_real squares[REGI_SMOOTH_ASKED];
    count = reg_kdtree_k_nearest(s->tree, s->points[point], asked, found, squares);
    for (int i = 0; i < count && kept < wanted; i++) {
        int other = found[i];
        if ((other == point && !with_itself) || (other != point && s->out[other]))
            continue;
        if (s->normals && sb_v3_dot(s->normals[point], s->normals[other]) < 0)
            continue;
        near[kept++] = other;
    }
    return kept;
}

/* Across the plane of least squares; returns 0 where the points spread in fewer than two directions. */
static int regi_smooth_place(const regi_smooth *s, int point, const int *near, int count, regi_smooth_frame *frame)
{
    sb_vec3 mean = sb_v3(0, 0, 0), values;
    sb_mat3 spread = sb_m3_zero(), vectors;
    sb_real farthest = 0;
    for (int i = 0; i < count; i++)
        mean = sb_v3_madd(mean, 1 / (sb_real)(i + 1), sb_v3_sub(s->points[near[i]], mean));
    for (int i = 0; i < count; i++) {
        sb_vec3 d = sb_v3_sub(s->points[near[i]], mean), way = sb_v3_sub(s->points[near[i]], s->points[point]);
        spread = sb_m3_add(spread, sb_m3_outer(d, d));
        farthest = sb_max(farthest, sb_v3_norm(way));
    }
    sb_m3_eigen(spread, &values, &vectors);
    frame->at = s->points[point];
    frame->x = sb_m3_column(vectors, 0);
    frame->y = sb_m3_column(vectors, 1);
    frame->z = sb_v3_cross(frame->x, frame->y);
    frame->scale = farthest;
    return farthest > 0 && values.y > 64 * SB_EPSILON * values.x;
}

static void regi_smooth_terms(const regi_smooth_frame *frame, sb_vec3 point, sb_real terms[REGI_SMOOTH_TERMS],
                              sb_real *height)
{
    sb_vec3 d = sb_v3_scale(1 / frame->scale, sb_v3_sub(point, frame->at));
    sb_real x = sb_v3_dot(d, frame->x), y = sb_v3_dot(d, frame->y);
    terms[0] = 1;
    terms[1] = x;
    terms[2] = y;
    terms[3] = x * x;
    terms[4] = x * y;
    terms[5] = y * y;
    *height = sb_v3_dot(d, frame->z) * frame->scale;
}

/* weights: NULL: all 1. */
static void regi_smooth_add(const regi_smooth *s, const regi_smooth_frame *frame, const int *near, int count,
                            const sb_real *weights, regi_smooth_sums *sums)
{
    sb_real terms[REGI_SMOOTH_TERMS], height;
    for (int i = 0; i < count; i++) {
        regi_smooth_terms(frame, s->points[near[i]], terms, &height);
        for (int a = 0; a < REGI_SMOOTH_TERMS; a++) {
            sb_real part = (weights ? weights[i] : 1) * terms[a];
            sums->right[a] += part * height;
            for (int b = 0; b <= a; b++)
                sums->matrix[a * REGI_SMOOTH_TERMS + b] += part * terms[b];
        }
    }
}

/* Coefficients, and the variance of the height at the point in those of one neighbour's. 0 when the sums do not
 * determine them. */
static int regi_smooth_solve(const regi_smooth_sums *sums, sb_real coefficients[REGI_SMOOTH_TERMS], sb_real *share)
{
    sb_real factor[REGI_SMOOTH_TERMS * REGI_SMOOTH_TERMS], first[REGI_SMOOTH_TERMS] = {1, 0, 0, 0, 0, 0};
    memcpy(factor, sums->matrix, sizeof factor);
    memcpy(coefficients, sums->right, sizeof sums->right);
    if (sb_cholesky_factor(factor, REGI_SMOOTH_TERMS))
        return 0;
    sb_cholesky_solve(factor, REGI_SMOOTH_TERMS, coefficients);
    sb_cholesky_solve(factor, REGI_SMOOTH_TERMS, first);
    *share = first[0];
    return 1;
}

/* ---- what is noise ---- */

/* Weights of a robust fit: small for those much farther off than the median, which is returned. */
static sb_real regi_smooth_doubt(const regi_smooth *s, const regi_smooth_frame *frame, const int *near, int count,
                                 const sb_real coefficients[REGI_SMOOTH_TERMS], sb_real *weights)
{
    sb_real off[REGI_SMOOTH_LEAST], sizes[REGI_SMOOTH_LEAST], terms[REGI_SMOOTH_TERMS], median;
    for (int i = 0; i < count; i++) {
        regi_smooth_terms(frame, s->points[near[i]], terms, &off[i]);
        for (int a = 0; a < REGI_SMOOTH_TERMS; a++)
            off[i] -= coefficients[a] * terms[a];
        off[i] = sb_abs(off[i]);
    }
    median = reg_outlier_limit(off, count, REG_OUTLIERS_TRIM, (sb_real)0.5, sizes);
    for (int i = 0; i < count; i++) {
        sb_real ratio = median > 0 ? off[i] / (3 * median) : 0;
        weights[i] = 1 / ((1 + ratio * ratio) * (1 + ratio * ratio));
    }
    return median;
}

/* How far a point is from the surface that its neighbours define. */
static void regi_smooth_judge(const regi_smooth *s, int point)
{
    int near[REGI_SMOOTH_LEAST], count = regi_smooth_neighbours(s, point, 0, REGI_SMOOTH_LEAST, near);
    sb_real weights[REGI_SMOOTH_LEAST], coefficients[REGI_SMOOTH_TERMS], share = 0, sum = 0;
    sb_real scatter = 0;
    regi_smooth_frame frame;
    regi_smooth_sums sums;
    int known = count > REGI_SMOOTH_TERMS && regi_smooth_place(s, point, near, count, &frame);
    for (int i = 0; i < sbi_min_int(count, REGI_SMOOTH_NEXT); i++)
        sum += sb_v3_norm(sb_v3_sub(s->points[near[i]], s->points[point]));
    s->spacing[point] = count > 0 ? sum / (sb_real)sbi_min_int(count, REGI_SMOOTH_NEXT) : 0;
    for (int round = 0; known && round < 3; round++) {
        memset(&sums, 0, sizeof sums);
        regi_smooth_add(s, &frame, near, count, round ? weights : NULL, &sums);
        known = regi_smooth_solve(&sums, coefficients, &share);
        if (known)
            scatter = regi_smooth_doubt(s, &frame, near, count, coefficients, weights);
    }
    s->scatter[point] = scatter;
    s->share[point] = known ? sb_sqrt(1 + share) : 1;
    s->residual[point] = known ? sb_abs(coefficients[0]) / s->share[point] : -1;
}

static void regi_smooth_judge_block(void *user, int block)
{
    const regi_smooth *s = (const regi_smooth *)user;
    int first = block * REGI_SMOOTH_BLOCK, last = sbi_min_int(s->count, first + REGI_SMOOTH_BLOCK);
    for (int i = first; i < last; i++)
        regi_smooth_judge(s, i);
}

static int regi_smooth_is_amid_outliers(const regi_smooth *s, int point)
{
    int near[REGI_SMOOTH_LEAST], out = 0;
    sb_real squares[REGI_SMOOTH_LEAST];
    int count = reg_kdtree_k_nearest(s->tree, s->points[point], REGI_SMOOTH_LEAST, near, squares);
    for (int i = 0; i < count; i++)
        out += s->out[near[i]];
    return 2 * out > count;
}

/* 1 for a point farther from the neighbours' surface than noise and their own spacing explain, much farther from all of
 * them than they are from theirs, or amid some that make no surface. */
static int regi_smooth_is_out(const regi_smooth *s, int point)
{
    int near[REGI_SMOOTH_LEAST], count = regi_smooth_neighbours(s, point, 0, REGI_SMOOTH_LEAST, near);
    sb_real around[REGI_SMOOTH_LEAST], sorted[REGI_SMOOTH_LEAST], usual;
    if (s->out[point])
        return 1;
    if (count < REGI_SMOOTH_LEAST)
        return regi_smooth_is_amid_outliers(s, point);
    for (int i = 0; i < count; i++)
        around[i] = s->spacing[near[i]];
    usual = reg_outlier_limit(around, count, REG_OUTLIERS_TRIM, (sb_real)0.25, sorted);
    return s->spacing[point] > (sb_real)2.5 * usual ||
           (s->spacing[point] > 2 * s->usual &&
            s->scatter[point] > sb_max(4 * s->noise, (sb_real)0.1 * s->spacing[point])) ||
           s->residual[point] > sb_max(4 * s->noise, usual / s->share[point]);
}

/* Residuals and their scale: sd of the noise across the surface. scratch[2 count] */
static void regi_smooth_measure(regi_smooth *s, const sb_jobs *jobs, sb_real *scratch)
{
    int known = 0;
    sb_real *sorted = scratch + s->count;
    sbi_run(jobs, regi_smooth_judge_block, s, (s->count - 1) / REGI_SMOOTH_BLOCK + 1);
    for (int i = 0; i < s->count; i++)
        if (s->residual[i] >= 0 && !s->out[i])
            scratch[known++] = s->residual[i];
    s->usual = reg_outlier_limit(s->spacing, s->count, REG_OUTLIERS_TRIM, (sb_real)0.5, sorted);
    s->noise = known ? (sb_real)1.4826 * reg_outlier_limit(scratch, known, REG_OUTLIERS_TRIM, (sb_real)0.5, sorted) : 0;
}

/* ---- smoothing ---- */

/* A point on the surface of a fit, and the normal there. */
static void regi_smooth_take(const regi_smooth *s, int point, const regi_smooth_frame *frame,
                             const sb_real coefficients[REGI_SMOOTH_TERMS], sb_real share)
{
    sb_vec3 normal = sb_v3_madd(sb_v3_scale(frame->scale, frame->z), -coefficients[1], frame->x);
    normal = regi_cloud_unit(sb_v3_madd(normal, -coefficients[2], frame->y));
    s->moved[point] = sb_v3_madd(s->points[point], coefficients[0], frame->z);
    if (s->normals)
        s->facing[point] = sb_v3_dot(s->normals[point], normal) < 0 ? sb_v3_scale(-1, normal) : normal;
    s->share[point] = sb_sqrt(share);
}

/* The widest fit that agrees with all narrower ones, and with the point itself, up to what noise does to each (the rule
 * of intersecting intervals: Goldenshluger, Nemirovski 1997): flat parts are smoothed widely, edges stay. An outlier
 * knows nothing of its own. */
static void regi_smooth_point(const regi_smooth *s, int point)
{
    int near[REGI_SMOOTH_MOST], count, done = 0, wanted = REGI_SMOOTH_LEAST;
    sb_real high = s->out[point] ? SB_REAL_MAX : 2 * s->noise, low = -high, share;
    sb_real coefficients[REGI_SMOOTH_TERMS];
    regi_smooth_frame frame;
    regi_smooth_sums sums;
    s->moved[point] = s->points[point];
    s->facing[point] = s->normals ? s->normals[point] : sb_v3(0, 0, 0);
    s->share[point] = 1;
    count = regi_smooth_neighbours(s, point, !s->out[point], REGI_SMOOTH_MOST, near);
    if (count < wanted || !regi_smooth_place(s, point, near, wanted, &frame))
        return;
    memset(&sums, 0, sizeof sums);
    for (; wanted <= count; wanted *= 2) {
        regi_smooth_add(s, &frame, near + done, wanted - done, NULL, &sums);
        done = wanted;
        if (!regi_smooth_solve(&sums, coefficients, &share) || !(share < 1))
            return; /* neighbours to one side say less than the point itself */
        low = sb_max(low, coefficients[0] - 2 * s->noise * sb_sqrt(share));
        high = sb_min(high, coefficients[0] + 2 * s->noise * sb_sqrt(share));
        if (low > high)
            return;
        regi_smooth_take(s, point, &frame, coefficients, share);
    }
}

static void regi_smooth_point_block(void *user, int block)
{
    const regi_smooth *s = (const regi_smooth *)user;
    int first = block * REGI_SMOOTH_BLOCK, last = sbi_min_int(s->count, first + REGI_SMOOTH_BLOCK);
    for (int i = first; i < last; i++)
        regi_smooth_point(s, i);
}

/* ---- all of it ---- */

/* What a run holds on to. */
typedef struct regi_smooth_work {
    regi_smooth pass;
    const sb_allocator *allocator;
    const sb_jobs *jobs;
    reg_kdtree *tree;
    sb_real *numbers;   /* [6 count] */
    sb_vec3 *vectors;   /* [4 count]: points, normals, moved, facing */
    unsigned char *out; /* [count] */
} regi_smooth_work;

static void regi_smooth_free(regi_smooth_work *w)
{
    reg_kdtree_destroy(w->tree);
    sbi_free(w->allocator, w->numbers);
    sbi_free(w->allocator, w->vectors);
    sbi_free(w->allocator, w->out);
}

static sb_result regi_smooth_begin(regi_smooth_work *w, const sb_vec3 *points, int count, const sb_allocator *allocator,
                                   const sb_jobs *jobs, sb_error *error)
{
    size_t n = (size_t)count;
    sb_result result;
    memset(w, 0, sizeof *w);
    w->allocator = allocator;
    w->jobs = jobs;
    result = regi_cloud_check(points, NULL, count, error);
    if (result != SB_OK)
        return result;
    w->numbers = (sb_real *)sbi_alloc(allocator, n, 6 * sizeof(sb_real));
    w->vectors = (sb_vec3 *)sbi_alloc(allocator, n, 4 * sizeof(sb_vec3));
    w->out = (unsigned char *)sbi_alloc_zeroed(allocator, n, 1);
    if (!w->numbers || !w->vectors || !w->out)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory to smooth %d points", count);
    memcpy(w->vectors, points, n * sizeof *points);
    w->pass.points = w->vectors;
    w->pass.count = count;
    w->pass.out = w->out;
    w->pass.residual = w->numbers;
    w->pass.share = w->numbers + n;
    w->pass.spacing = w->numbers + 2 * n;
    w->pass.scatter = w->numbers + 3 * n;
    w->pass.moved = w->vectors + 2 * n;
    w->pass.facing = w->vectors + 3 * n;
    return SB_OK;
}

static sb_result regi_smooth_plant(regi_smooth_work *w, sb_error *error)
{
    sb_result result;
    reg_kdtree_destroy(w->tree);
    w->tree = NULL;
    result = reg_kdtree_create(w->pass.points, w->pass.count, w->allocator, &w->tree, error);
    w->pass.tree = w->tree;
    return result;
}

/* Marks outliers until there are no more: at first they spoil what their neighbours say. Returns how many. */
static int regi_smooth_find_out(regi_smooth_work *w)
{
    unsigned char *marks = (unsigned char *)w->pass.moved; /* not in use yet */
    int n = w->pass.count, found = 0, more = 1;
    for (int round = 0; round < REGI_SMOOTH_ROUNDS && more; round++) {
        regi_smooth_measure(&w->pass, w->jobs, w->numbers + 4 * (size_t)n);
        more = 0;
        for (int i = 0; i < n; i++) {
            marks[i] = (unsigned char)regi_smooth_is_out(&w->pass, i);
            more += marks[i] - w->out[i];
        }
        memcpy(w->out, marks, (size_t)n);
    }
    for (int i = 0; i < n; i++)
        found += w->out[i];
    return found;
}

/* Noise far below the points' spacing is the surface's own curvature, or does no harm. */
static int regi_smooth_run(regi_smooth_work *w, reg_smooth_info *info)
{
    regi_smooth *s = &w->pass;
    double sum = 0;
    regi_smooth_measure(s, w->jobs, w->numbers + 4 * (size_t)s->count);
    info->noise = info->left = s->noise;
    if (!(s->noise > (sb_real)0.04 * s->usual))
        return 0;
    sbi_run(w->jobs, regi_smooth_point_block, s, (s->count - 1) / REGI_SMOOTH_BLOCK + 1);
    for (int i = 0; i < s->count; i++)
        sum += (double)(s->share[i] * s->share[i]);
    info->left = s->noise * sb_sqrt((sb_real)(sum / s->count));
    return 1;
}

REG_API sb_result reg_cloud_smooth(reg_cloud *cloud, const sb_jobs *jobs, reg_smooth_info *info, sb_error *error)
{
    regi_smooth_work w;
    reg_smooth_info found;
    sb_result result;
    int kept = 0;
    if (!cloud)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "there is no cloud to smooth");
    memset(&found, 0, sizeof found);
    result = regi_smooth_begin(&w, cloud->points, cloud->count, &cloud->allocator, jobs, error);
    w.pass.normals = cloud->normals;
    if (result == SB_OK)
        result = regi_smooth_plant(&w, error);
    if (result == SB_OK) {
        int moved;
        found.outliers = regi_smooth_find_out(&w);
        moved = regi_smooth_run(&w, &found);
        for (int i = 0; i < cloud->count; i++) {
            if (w.out[i])
                continue;
            if (cloud->normals)
                cloud->normals[kept] = moved ? w.pass.facing[i] : cloud->normals[i];
            cloud->points[kept++] = moved ? w.pass.moved[i] : cloud->points[i];
        }
        cloud->count = kept;
        if (info)
            *info = found;
    }
    regi_smooth_free(&w);
    return result;
}

/* Marks nodes whose shortest edge is three times as long as their neighbours' are on average: those that lie far away
 * from where the mesh has them, which no neighbours in space could give where many lie far away. */
static void regi_smooth_find_stretched(regi_smooth_work *w, const sbi_surface_cut *cut)
{
    int n = w->pass.count;
    sb_real *shortest = w->numbers, *sum = w->numbers + n, *count = w->numbers + 2 * (size_t)n;
    for (int i = 0; i < n; i++)
        shortest[i] = SB_REAL_MAX;
    for (int pass = 0; pass <= REGI_SMOOTH_ROUNDS; pass++) { /* the first one measures */
        for (int i = 0; i < n; i++)
            sum[i] = count[i] = 0;
        for (int k = 0; k < 6 * cut->triangles.element_count; k++) {
            const int *c = cut->triangles.elements + k / 6 * 3;
            int from = c[k % 3], to = c[(k % 3 + 1 + k % 6 / 3) % 3];
            if (pass == 0)
                shortest[to] = sb_min(shortest[to], sb_v3_norm(sb_v3_sub(w->vectors[from], w->vectors[to])));
            else
                sum[to] += w->out[from] ? 0 : shortest[from];
            count[to] += !w->out[from];
        }
        for (int i = 0; i < n && pass > 0; i++)
            w->out[i] = w->out[i] || (count[i] > 0 && shortest[i] * count[i] > 3 * sum[i]);
    }
}

/* Puts outliers amid their neighbours in the mesh, those next to good nodes first. What only has outliers around it
 * stays. */
static void regi_smooth_recall(regi_smooth_work *w, const sbi_surface_cut *cut)
{
    size_t n = (size_t)w->pass.count;
    sb_vec3 *sums = w->pass.moved;
    int *counts = (int *)w->pass.facing, left = 1;
    unsigned char *lost = (unsigned char *)w->numbers;
    memcpy(lost, w->out, n);
    while (left) {
        left = 0;
        memset(sums, 0, n * sizeof *sums);
        memset(counts, 0, n * sizeof *counts);
        for (int k = 0; k < 3 * cut->triangles.element_count; k++) {
            const int *c = cut->triangles.elements + k / 3 * 3;
            int to = c[k % 3];
            for (int j = 1; j < 3 && lost[to]; j++) {
                int from = c[(k + j) % 3];
                if (lost[from])
                    continue;
                sums[to] = sb_v3_add(sums[to], w->vectors[from]);
                counts[to]++;
            }
        }
        for (size_t i = 0; i < n; i++)
            if (counts[i] > 0) {
                w->vectors[i] = sb_v3_scale(1 / (sb_real)counts[i], sums[i]);
                lost[i] = 0;
                left = 1;
            }
    }
}

REG_API sb_result reg_cloud_smooth_mesh(sb_mesh *surface, const sb_jobs *jobs, reg_smooth_info *info, sb_error *error)
{
    regi_smooth_work w;
    reg_smooth_info found;
    sbi_surface_cut cut;
    sb_result result;
    if (!surface)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "there is no surface to smooth");
    memset(&found, 0, sizeof found);
    result = sbi_surface_cut_make(surface, &surface->allocator, &cut, error);
    if (result != SB_OK)
        return result;
    result = regi_smooth_begin(&w, surface->nodes, surface->node_count, &surface->allocator, jobs, error);
    if (result == SB_OK)
        result = regi_smooth_plant(&w, error);
    if (result == SB_OK) {
        regi_smooth_find_stretched(&w, &cut);
        found.outliers = regi_smooth_find_out(&w);
        regi_smooth_recall(&w, &cut);
        result = regi_smooth_plant(&w, error);
    }
    if (result == SB_OK) {
        sb_vec3 *normals = w.vectors + w.pass.count, *kept = cut.triangles.nodes;
        cut.triangles.nodes = w.vectors;
        regi_cloud_face_normals(&cut, normals);
        cut.triangles.nodes = kept;
        w.pass.normals = normals;
        memcpy(surface->nodes, regi_smooth_run(&w, &found) ? w.pass.moved : w.pass.points,
               (size_t)surface->node_count * sizeof(sb_vec3));
        if (info)
            *info = found;
    }
    regi_smooth_free(&w);
    sbi_surface_cut_free(&surface->allocator, &cut);
    return result;
}

/* ==== src/register/field.c ==== */
/* field: distances to surfaces and clouds, and Laplace's potential on a grid. */

#include <string.h>


#define REGI_FIELD_COOKIE 0x66696c64u

enum { REGI_FIELD_NEIGHBOURS = 12 }; /* points of a cloud that decide whether one of them is on its rim */

/* Laplace's potential at the corners of a grid of cubes. */
typedef struct regi_field_grid {
    sb_vec3 low;
    sb_real cell; /* m */
    int count[3]; /* corners along each axis */
    sb_real *phi; /* [corners] m, x fastest */
    int sweeps;
} regi_field_grid;

struct reg_field {
    sb_allocator allocator;
    reg_field_kind kind;
    sb_vec3 low, high;
    sb_surface *surface;
    reg_kdtree *tree; /* of a cloud; NULL for a surface */
    int point_count;
    sb_vec3 *points;       /* of the cloud */
    sb_vec3 *normals;      /* of the cloud, unit or 0; NULL: none */
    unsigned char *border; /* triangles: bit i for edge i, bit 3 + i for corner i; points: 1 */
    regi_field_grid grid;
};

REG_API reg_field_def reg_default_field_def(void)
{
    reg_field_def def;
    memset(&def, 0, sizeof def);
    def.kind = REG_FIELD_DISTANCE;
    def.cells = 64;
    def.cookie = REGI_FIELD_COOKIE;
    return def;
}

REG_API void reg_field_destroy(reg_field *field)
{
    sb_allocator allocator;
    if (!field)
        return;
    allocator = field->allocator;
    sb_surface_destroy(field->surface);
    reg_kdtree_destroy(field->tree);
    sbi_free(&allocator, field->points);
    sbi_free(&allocator, field->normals);
    sbi_free(&allocator, field->border);
    sbi_free(&allocator, field->grid.phi);
    sbi_free(&allocator, field);
}

/* ---- checks ---- */

static sb_result regi_field_check_points(const reg_field_def *def, sb_error *error)
{
    if (def->point_count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a cloud of %d points is no target", def->point_count);
    for (int i = 0; i < def->point_count; i++) {
        if (!sb_v3_is_finite(def->points[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "point %d of the target is not finite", i);
        if (def->normals && !sb_v3_is_finite(def->normals[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "normal %d of the target is not finite", i);
    }
    return SB_OK;
}

static sb_result regi_field_check(const reg_field_def *def, sb_error *error)
{
    if (!def || def->cookie != REGI_FIELD_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a field needs a def made by reg_default_field_def");
    if (def->kind != REG_FIELD_DISTANCE && def->kind != REG_FIELD_LAPLACE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "there is no field of kind %d", (int)def->kind);
    if ((def->surface != NULL) == (def->points != NULL))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a field needs either a surface or points");
    if (def->cells < 8 || def->cells > 256)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "cells is %d, not in [8, 256]", def->cells);
    if (!sb_v3_is_finite(def->low) || !sb_v3_is_finite(def->high))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "a corner of the field's box is not finite");
    if (def->high.x < def->low.x || def->high.y < def->low.y || def->high.z < def->low.z)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the box of the field has high below low");
    return def->points ? regi_field_check_points(def, error) : SB_OK;
}

/* ---- a surface and its rim ---- */

/* Bits of the edges that no other triangle shares, then of all corners at such edges. rim: scratch [nodes], zeroed. */
static void regi_field_mark_border(const sb_mesh *mesh, const sb_index_table *neighbours, unsigned char *rim,
                                   unsigned char *border)
{
    for (int t = 0; t < mesh->element_count; t++) {
        border[t] = 0;
        for (int i = 0; i < 3; i++)
            if (neighbours->items[3 * t + i] < 0) {
                border[t] = (unsigned char)(border[t] | 1 << i);
                rim[mesh->elements[3 * t + i]] = rim[mesh->elements[3 * t + (i + 1) % 3]] = 1;
            }
    }
    for (int t = 0; t < mesh->element_count; t++)
        for (int i = 0; i < 3; i++)
            if (rim[mesh->elements[3 * t + i]])
                border[t] = (unsigned char)(border[t] | 8 << i);
}

static sb_result regi_field_find_border(reg_field *field, const sb_mesh *mesh, sb_error *error)
{
    sb_index_table neighbours;
    unsigned char *rim;
    sb_result result = sb_mesh_neighbours(mesh, &field->allocator, &neighbours, error);
    if (result != SB_OK)
        return result;
    rim = (unsigned char *)sbi_alloc_zeroed(&field->allocator, (size_t)mesh->node_count, 1);
    field->border = (unsigned char *)sbi_alloc(&field->allocator, (size_t)mesh->element_count, 1);
    if (rim && field->border)
        regi_field_mark_border(mesh, &neighbours, rim, field->border);
    else
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the rim of %d triangles", mesh->element_count);
    sbi_free(&field->allocator, rim);
    sb_index_table_free(&neighbours);
    return result;
}

static sb_result regi_field_make_surface(reg_field *field, const sb_mesh *surface, sb_error *error)
{
    sb_mesh triangles;
    sb_result result = sb_surface_triangulate(surface, &field->allocator, &triangles, error);
    if (result != SB_OK)
        return result;
    result = sb_surface_create(&triangles, &field->allocator, &field->surface, error);
    if (result == SB_OK)
        result = regi_field_find_border(field, &triangles, error);
    if (result == SB_OK)
        sb_surface_bounds(field->surface, &field->low, &field->high);
    sb_mesh_free(&triangles);
    return result;
}

/* ---- a cloud and its rim ---- */

/* On a rim the neighbours lie to one side: the centre of a half disc is 0.42 radii from the middle of its straight
 * edge. */
static int regi_field_is_rim(const reg_field *field, int point)
{
    int near[REGI_FIELD_NEIGHBOURS];
    sb_real squares[REGI_FIELD_NEIGHBOURS];
    sb_vec3 centre = sb_v3(0, 0, 0), at = field->points[point];
    int count = reg_kdtree_k_nearest(field->tree, at, REGI_FIELD_NEIGHBOURS, near, squares);
    if (count < REGI_FIELD_NEIGHBOURS)
        return 0;
    for (int i = 0; i < count; i++)
        centre = sb_v3_madd(centre, (sb_real)1 / (sb_real)count, sb_v3_sub(field->points[near[i]], at));
    return sb_v3_dot(centre, centre) > (sb_real)(0.3 * 0.3) * squares[count - 1];
}

enum { REGI_FIELD_CHUNK = 1024 };

static void regi_field_find_rims(void *user, int chunk)
{
    reg_field *field = (reg_field *)user;
    int first = chunk * REGI_FIELD_CHUNK, last = first + sbi_min_int(REGI_FIELD_CHUNK, field->point_count - first);
    for (int i = first; i < last; i++)
        field->border[i] = (unsigned char)regi_field_is_rim(field, i);
}

static sb_result regi_field_make_cloud(reg_field *field, const reg_field_def *def, sb_error *error)
{
    size_t count = (size_t)def->point_count;
    sb_result result = reg_kdtree_create(def->points, def->point_count, &field->allocator, &field->tree, error);
    if (result != SB_OK)
        return result;
    field->point_count = def->point_count;
    field->points = (sb_vec3 *)sbi_alloc(&field->allocator, count, sizeof(sb_vec3));
    field->border = (unsigned char *)sbi_alloc(&field->allocator, count, 1);
    if (def->normals)
        field->normals = (sb_vec3 *)sbi_alloc(&field->allocator, count, sizeof(sb_vec3));
    if (!field->points || !field->border || (def->normals && !field->normals))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a target of %d points", def->point_count);
    memcpy(field->points, def->points, count * sizeof(sb_vec3));
    field->low = field->high = def->points[0];
    for (int i = 0; i < def->point_count; i++) {
        sb_vec3 p = def->points[i], n = def->normals ? def->normals[i] : p;
        sb_real length = sb_v3_norm(n);
        field->low = sb_v3(sb_min(field->low.x, p.x), sb_min(field->low.y, p.y), sb_min(field->low.z, p.z));
        field->high = sb_v3(sb_max(field->high.x, p.x), sb_max(field->high.y, p.y), sb_max(field->high.z, p.z));
        if (def->normals)
            field->normals[i] = length > 0 ? sb_v3_scale((sb_real)1 / length, n) : sb_v3(0, 0, 0);
    }
    sbi_run(&def->jobs, regi_field_find_rims, field, (def->point_count - 1) / REGI_FIELD_CHUNK + 1);
    return SB_OK;
}

/* ---- closest places ---- */

static int regi_field_closest_triangle(const reg_field *field, sb_vec3 point, int guess, reg_field_hit *hit)
{
    sb_surface_hit found;
    unsigned rim;
    if (!sb_surface_closest_from(field->surface, point, SB_REAL_MAX, guess, &found))
        return 0;
    rim = field->border[found.triangle];
    hit->point = found.point;
    hit->normal = sb_surface_normal(field->surface, &found);
    hit->distance = found.distance;
    hit->item = found.triangle;
    hit->on_border = (found.feature == SB_SURFACE_EDGE && (rim >> found.index & 1)) ||
                     (found.feature == SB_SURFACE_VERTEX && (rim >> (3 + found.index) & 1));
    return 1;
}

static int regi_field_closest_point(const reg_field *field, sb_vec3 point, reg_field_hit *hit)
{
    sb_real square = 0;
    int nearest = sb_v3_is_finite(point) ? reg_kdtree_nearest(field->tree, point, SB_REAL_MAX, &square) : -1;
    if (nearest < 0 || !sb_is_finite(square))
        return 0;
    hit->point = field->points[nearest];
    hit->normal = field->normals ? field->normals[nearest] : sb_v3(0, 0, 0);
    hit->distance = sb_sqrt(square);
    hit->item = nearest;
    hit->on_border = field->border[nearest];
    return 1;
}

REG_API int reg_field_closest(const reg_field *field, sb_vec3 point, int guess, reg_field_hit *hit)
{
    if (!field || !hit)
        return 0;
    return field->tree ? regi_field_closest_point(field, point, hit)
                       : regi_field_closest_triangle(field, point, guess, hit);
}

/* ---- the grid ---- */

/* Cell and place within it, in [0, 1], along one axis. */
static int regi_field_locate(sb_real x, sb_real low, sb_real cell, int corners, sb_real *share)
{
    sb_real place = (x - low) / cell, last = (sb_real)(corners - 1);
    int index;
    place = sb_max(0, sb_min(place, last));
    index = sbi_min_int((int)place, corners - 2);
    *share = place - (sb_real)index;
    return index;
}

/* Trilinear interpolation and its gradient. */
static sb_real regi_field_interpolate(const regi_field_grid *grid, sb_vec3 point, sb_vec3 *gradient)
{
    sb_real s[3], phi = 0, slope[3] = {0, 0, 0};
    int i = regi_field_locate(point.x, grid->low.x, grid->cell, grid->count[0], &s[0]);
    int j = regi_field_locate(point.y, grid->low.y, grid->cell, grid->count[1], &s[1]);
    int k = regi_field_locate(point.z, grid->low.z, grid->cell, grid->count[2], &s[2]);
    size_t row = (size_t)grid->count[0], plane = row * (size_t)grid->count[1];
    const sb_real *at = grid->phi + (size_t)i + (size_t)j * row + (size_t)k * plane;
    for (int corner = 0; corner < 8; corner++) {
        int bit[3] = {corner & 1, corner >> 1 & 1, corner >> 2};
        sb_real value = at[(size_t)bit[0] + (size_t)bit[1] * row + (size_t)bit[2] * plane], w[3];
        for (int a = 0; a < 3; a++)
            w[a] = bit[a] ? s[a] : 1 - s[a];
        phi += w[0] * w[1] * w[2] * value;
        for (int a = 0; a < 3; a++)
            slope[a] += (bit[a] ? value : -value) * w[(a + 1) % 3] * w[(a + 2) % 3];
    }
    *gradient = sb_v3_scale((sb_real)1 / grid->cell, sb_v3(slope[0], slope[1], slope[2]));
    return phi;
}

static sb_vec3 regi_field_corner(const regi_field_grid *grid, int i, int j, int k)
{
    return sb_v3_madd(grid->low, grid->cell, sb_v3((sb_real)i, (sb_real)j, (sb_real)k));
}

/* What setting up the grid's rows of corners needs; each (j, k) is one task. */
typedef struct regi_field_filling {
    const reg_field *field;
    unsigned char *held; /* [corners] 1: the value is given */
} regi_field_filling;

/* Corners next to the target have their distance to it, which is what its zero means for them; those on the box
 * have theirs too; all others start there. */
static void regi_field_fill_row(void *user, int row)
{
    const regi_field_filling *filling = (const regi_field_filling *)user;
    const regi_field_grid *grid = &filling->field->grid;
    int j = row % grid->count[1], k = row / grid->count[1], guess = -1;
    int outer = j == 0 || k == 0 || j == grid->count[1] - 1 || k == grid->count[2] - 1;
    for (int i = 0; i < grid->count[0]; i++) {
        size_t at = (size_t)row * (size_t)grid->count[0] + (size_t)i;
        reg_field_hit hit;
        hit.distance = 0;
        if (reg_field_closest(filling->field, regi_field_corner(grid, i, j, k), guess, &hit))
            guess = hit.item;
        grid->phi[at] = hit.distance;
        filling->held[at] = outer || i == 0 || i == grid->count[0] - 1 || hit.distance < (sb_real)0.87 * grid->cell;
    }
}

/* One half sweep of successive over-relaxation over the corners of one colour of a chessboard. Returns the largest
 * change. */
static sb_real regi_field_relax(regi_field_grid *grid, const unsigned char *held, int colour, sb_real omega)
{
    size_t row = (size_t)grid->count[0], plane = row * (size_t)grid->count[1];
    sb_real most = 0;
    for (int k = 1; k < grid->count[2] - 1; k++)
        for (int j = 1; j < grid->count[1] - 1; j++) {
            sb_real *phi = grid->phi + (size_t)k * plane + (size_t)j * row;
            const unsigned char *given = held + (size_t)k * plane + (size_t)j * row;
            for (int i = 1 + (j + k + colour) % 2; i < grid->count[0] - 1; i += 2) {
                sb_real *p = phi + i;
                sb_real mean = (p[-1] + p[1] + *(p - row) + *(p + row) + *(p - plane) + *(p + plane)) / 6;
                sb_real change = given[i] ? 0 : omega * (mean - *p);
                *p += change;
                most = sb_max(most, sb_abs(change));
            }
        }
    return most;
}

/* The factor that is best for a cube of as many cells. */
static sb_real regi_field_omega(const regi_field_grid *grid)
{
    sb_real s, c;
    int longest = sbi_max_int(grid->count[0], sbi_max_int(grid->count[1], grid->count[2]));
    sb_sin_cos((sb_real)3.14159265358979 / (sb_real)longest, &s, &c);
    return 2 / (1 + s);
}

/* Until no corner changes by more than 1e-4 cells in a sweep, which is far below what the grid resolves. */
static void regi_field_solve(regi_field_grid *grid, const unsigned char *held)
{
    sb_real omega = regi_field_omega(grid), enough = (sb_real)1e-4 * grid->cell, change = enough + 1;
    for (grid->sweeps = 0; grid->sweeps < 2000 && change > enough; grid->sweeps++) {
        change = regi_field_relax(grid, held, 0, omega);
        change = sb_max(change, regi_field_relax(grid, held, 1, omega));
    }
}

/* The box of the def, enlarged, and the number of corners; 0 when it is too large for numbers. */
static int regi_field_plan(reg_field *field, const reg_field_def *def)
{
    regi_field_grid *grid = &field->grid;
    sb_real margin = (sb_real)0.1 * sb_v3_norm(sb_v3_sub(field->high, field->low)), longest;
    sb_vec3 edge, low = sb_v3_sub(field->low, sb_v3(margin, margin, margin));
    sb_vec3 high = sb_v3_add(field->high, sb_v3(margin, margin, margin)), size = sb_v3_sub(def->high, def->low);
    if (size.x > 0 || size.y > 0 || size.z > 0) {
        low = sb_v3(sb_min(low.x, def->low.x), sb_min(low.y, def->low.y), sb_min(low.z, def->low.z));
        high = sb_v3(sb_max(high.x, def->high.x), sb_max(high.y, def->high.y), sb_max(high.z, def->high.z));
    }
    edge = sb_v3_sub(high, low);
    longest = sb_max(edge.x, sb_max(edge.y, edge.z));
    if (!sb_is_finite(longest) || !sb_v3_is_finite(edge))
        return 0;
    grid->low = low;
    grid->cell = longest > 0 ? longest / (sb_real)def->cells : 1;
    grid->count[0] = sbi_max_int((int)(edge.x / grid->cell + (sb_real)0.999), 2) + 1;
    grid->count[1] = sbi_max_int((int)(edge.y / grid->cell + (sb_real)0.999), 2) + 1;
    grid->count[2] = sbi_max_int((int)(edge.z / grid->cell + (sb_real)0.999), 2) + 1;
    return 1;
}

static sb_result regi_field_make_grid(reg_field *field, const reg_field_def *def, sb_error *error)
{
    regi_field_filling filling;
    size_t corners;
    if (!regi_field_plan(field, def))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the target is too large for a potential");
    corners = (size_t)field->grid.count[0] * (size_t)field->grid.count[1] * (size_t)field->grid.count[2];
    field->grid.phi = (sb_real *)sbi_alloc(&field->allocator, corners, sizeof(sb_real));
    filling.field = field;
    filling.held = (unsigned char *)sbi_alloc(&field->allocator, corners, 1);
    if (!field->grid.phi || !filling.held) {
        sbi_free(&field->allocator, filling.held);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a potential of %d cells a side", def->cells);
    }
    sbi_run(&def->jobs, regi_field_fill_row, &filling, field->grid.count[1] * field->grid.count[2]);
    regi_field_solve(&field->grid, filling.held);
    sbi_free(&field->allocator, filling.held);
    return SB_OK;
}

/* ---- life ---- */

REG_API sb_result reg_field_create(const reg_field_def *def, reg_field **field, sb_error *error)
{
    reg_field *made;
    sb_result result = regi_field_check(def, error);
    if (result == SB_OK && !field)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "there is no place for the field");
    if (result != SB_OK)
        return result;
    made = (reg_field *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a field");
    made->allocator = def->allocator;
    made->kind = def->kind;
    result =
        def->surface ? regi_field_make_surface(made, def->surface, error) : regi_field_make_cloud(made, def, error);
    if (result == SB_OK && def->kind == REG_FIELD_LAPLACE)
        result = regi_field_make_grid(made, def, error);
    if (result != SB_OK) {
        reg_field_destroy(made);
        return result;
    }
    *field = made;
    return SB_OK;
}

/* ---- the potential ---- */

REG_API int reg_field_at(const reg_field *field, sb_vec3 point, int guess, sb_real *phi, sb_vec3 *gradient)
{
    reg_field_hit hit;
    sb_vec3 slope = sb_v3(0, 0, 0);
    if (!field || !phi)
        return 0;
    if (field->kind == REG_FIELD_LAPLACE) {
        if (!sb_v3_is_finite(point))
            return 0;
        *phi = regi_field_interpolate(&field->grid, point, &slope);
    } else {
        if (!reg_field_closest(field, point, guess, &hit))
            return 0;
        *phi = hit.distance;
        if (hit.distance > 0)
            slope = sb_v3_scale((sb_real)1 / hit.distance, sb_v3_sub(point, hit.point));
    }
    if (gradient)
        *gradient = slope;
    return 1;
}

REG_API int reg_field_along(const reg_field *field, sb_vec3 point, sb_vec3 direction, sb_real step, int guess,
                            reg_field_sample *sample)
{
    sb_real half = (sb_real)0.5 * step, before, after, phi;
    sb_vec3 slope_before, slope_after;
    if (!field || !sample)
        return 0;
    if (!reg_field_at(field, point, guess, &phi, NULL) ||
        !reg_field_at(field, sb_v3_madd(point, -half, direction), guess, &before, &slope_before) ||
        !reg_field_at(field, sb_v3_madd(point, half, direction), guess, &after, &slope_after))
        return 0;
    sample->phi = phi;
    sample->phi_n = (after - before) / step;
    sample->phi_nn = sb_v3_dot(direction, sb_v3_sub(slope_after, slope_before)) / step;
    return 1;
}

REG_API void reg_field_bounds(const reg_field *field, sb_vec3 *low, sb_vec3 *high)
{
    if (!field || !low || !high)
        return;
    *low = field->low;
    *high = field->high;
}

REGI_API int regi_field_is_open(const reg_field *field)
{
    int triangles = field->surface ? sb_surface_triangle_count(field->surface) : 0;
    for (int t = 0; t < triangles; t++)
        if (field->border[t])
            return 1;
    return field->tree != NULL;
}

REG_API int reg_field_sweeps(const reg_field *field) { return field ? field->grid.sweeps : 0; }

/* ==== src/register/icp_private.h ==== */
/* icp_private: what is inside a reg_icp. Floor 6, internal: icp_side.c makes the shapes, icp_step.c pairs and moves
 * them, pose.c searches and weighs poses, icp.c is the call.
 *
 * One shape is `a` and looks for the other, `b`; with WHOLE both look. The motion sought is that of a onto b: the
 * model's onto the target, or with TARGET_PART its inverse. */
#ifndef REG_ICP_PRIVATE_H
#define REG_ICP_PRIVATE_H


enum { REGI_ICP_FINE = 600 }; /* points of a shape in the search */

/* Points that look for partners. */
typedef struct regi_icp_set {
    sb_vec3 *points, *normals;
    sb_real *weights;
    int *partner; /* the last one found, which is likely to be near again: point, or triangle of the surface */
    int count;
} regi_icp_set;

/* A shape: what is found, and samples of it that look. */
typedef struct regi_icp_side {
    const sb_vec3 *points, *normals;
    const sb_real *weights, *sd;
    sb_real usual_sd; /* m, the median; 1 without sd */
    int count;
    const sb_surface *surface;
    const reg_kdtree *tree;
    int sign;    /* -1: its normals point inwards, and count turned */
    int unsure;  /* which way the normals point is not known: both ways are tried */
    int fitted;  /* its normals are fitted */
    int cleaned; /* isolated points are out already */
    int closed;  /* a closed surface */
    reg_kdtree *own_tree;
    reg_cloud own;
    sb_real *own_weights; /* from weights and sd */
    regi_icp_set sample;  /* of the last stage */
    regi_icp_set spread;  /* of the search: evenly spread, so that any first part of it is, too */
    reg_kdtree *spread_tree;
    sb_vec3 centre;
    sb_mat3 axes;    /* columns: principal axes, turned the way the points are skewed */
    sb_real size;    /* m, rms distance from the centre */
    sb_real extent;  /* m, diagonal of the spread points' box */
    sb_real area;    /* m^2, estimated */
    sb_real spacing; /* m, between its points */
} regi_icp_side;

typedef struct regi_icp_pairs {
    sb_vec3 *from, *to, *normal;
    sb_real *weight, *distance, *scratch;
    int count;
} regi_icp_pairs;

typedef struct regi_icp {
    const reg_icp_options *options;
    const sb_allocator *allocator;
    sb_error *error;
    regi_icp_side a, b;
    int both, swapped;
    regi_icp_pairs pairs;
    sb_vec3 *landmarks_a, *landmarks_b;
    const reg_icp_shape *target;
    unsigned warnings;
    double begun;
    int out_of_time;
} regi_icp;

/* How a stage works. */
typedef struct regi_icp_stage {
    int spread; /* the evenly spread points look instead of the sample */
    int coarse; /* and are looked at instead of all; needs `spread` */
    int points; /* of a set that look */
    reg_icp_metric metric;
    reg_outliers outliers;
    sb_real parameter;
    sb_real reach; /* m */
    sb_real lost;  /* m: what an outlier counts in the score; 0: no score wanted */
    int flip;      /* -1: the normals of one of the sides point the wrong way */
} regi_icp_stage;

/* A pose: motion of a onto b. */
typedef struct regi_pose {
    reg_rigid motion;
    sb_real score;       /* m, of the search */
    sb_real likelihood;  /* nats, tempered */
    sb_real noise;       /* m, robust, of the gaps */
    sb_real lost;        /* share of points that find nothing within 6 noise */
    sb_real correlation; /* of neighbouring gaps, in [0, 1] */
    sb_real in_front;    /* share of the model that would hide what the camera saw */
    int flip;
} regi_pose;

/* Normal equations of the small motion, turn about a's moved centre and shift, that lowers sum w (n . (x - to))^2.
 * Lengths are in units of a's size, so that turns and shifts are alike. */
typedef struct regi_icp_system {
    sb_real matrix[6][6], right[6]; /* lower triangle */
} regi_icp_system;

/* ---- icp_side.c ---- */
REGI_API sb_result regi_icp_no_memory(const regi_icp *icp);
REGI_API sb_result regi_icp_side_make(regi_icp *icp, const reg_icp_shape *shape, regi_icp_side *side);
/* What a point of the side counts, by its weight and its sd. */
REGI_API sb_real regi_icp_weight(const regi_icp_side *side, int point);
REGI_API void regi_icp_side_free(const sb_allocator *allocator, regi_icp_side *side);
/* Mean of the normals: where an open shape is seen from; 0 for a closed one. */
REGI_API sb_vec3 regi_icp_facing(const regi_icp_set *set);

/* The motion of the model onto the target. */
REGI_API reg_rigid regi_icp_of_model(const regi_icp *icp, const reg_rigid *motion);

/* ---- icp_step.c ---- */
/* Pairs for this motion, and the score: the mean of min(distance, lost), landmarks included. */
REGI_API sb_real regi_icp_pair(regi_icp *icp, const regi_icp_stage *stage, const reg_rigid *motion);
/* Number and weighted mean and rms distance of the pairs that count. */
REGI_API int regi_icp_measure(const regi_icp_pairs *pairs, sb_real *mean, sb_real *rms);
/* At most `rounds` rounds; returns how many. The pairs are left as they are for *motion. */
REGI_API int regi_icp_iterate(regi_icp *icp, const regi_icp_stage *stage, int rounds, sb_real tolerance,
                              reg_rigid *motion, sb_real *score, int *converged);

/* Of the pairs and the landmarks. at_planes: arms reach to the partners and not to the points: how points lie beside
 * their partners then tells no turn. */
REGI_API void regi_icp_equations(const regi_icp *icp, const reg_rigid *motion, int at_planes, regi_icp_system *system);
/* Cholesky, in place; the solution replaces the right-hand side. The matrix has to be positive definite, by damping. */
REGI_API void regi_icp_solve(regi_icp_system *system);

/* ---- pose_view.c ---- */
/* Log-likelihood of a pose by what the caller knows; angles may be off by `slack` (rad) for nothing, and shifts then
 * do not count. */
REGI_API sb_real regi_pose_prior(const regi_icp *icp, const regi_pose *pose, sb_real slack);
/* Share of the model, of what is inside the camera's view of the target, that would be nearer to the camera than what
 * it saw by 2 % of the model's size; 0 without a camera. */
REGI_API sb_real regi_pose_in_front(const regi_icp *icp, const reg_rigid *motion);

/* ---- pose.c ---- */
/* As many independent points as what looks is worth: patches of a tenth of the model's size in radius, as far as the
 * points' gaps are correlated. */
REGI_API sb_real regi_pose_points(const regi_icp *icp, sb_real correlation);
/* Fills the poses' likelihoods and what they come from, and sorts them by it. Overwrites the pairs. */
REGI_API sb_result regi_pose_rank(regi_icp *icp, const regi_icp_stage *last, regi_pose *poses, int count);
/* Of poses, the best first, those that differ from all before them, by 8 degrees or, in the mean over the model, by 5 %
 * of its size; up to `kept`. Returns how many. */
REGI_API int regi_pose_distinct(const regi_icp *icp, regi_pose *poses, int count, int kept);
/* Finds poses[REG_ICP_POSES], the likeliest first: *count >= 1; *tried: how many were begun with. */
REGI_API sb_result regi_pose_search(regi_icp *icp, const reg_rigid *start, const regi_icp_stage *last, regi_pose *poses,
                                    int *count, int *tried);

/* ---- icp_report.c ---- */
/* Noise, covariance, and warnings of the result, of which the pairs are the last. Overwrites them. */
REGI_API sb_result regi_icp_report(regi_icp *icp, const regi_icp_stage *stage, const regi_pose *best,
                                   reg_icp_info *info);

#endif /* REG_ICP_PRIVATE_H */

/* ==== src/register/icp_side.c ==== */
/* icp_side: the shapes of an alignment: which of their points look, which way their normals point. */

enum {
    REGI_ICP_FITTED = 6000, /* more points than these are thinned before normals are fitted */
    REGI_ICP_NEIGHBOURS = 16,
    REGI_ICP_NEAR = 9, /* neighbours that tell whether a point is isolated */
    REGI_ICP_CROWD = 4 * REGI_ICP_FINE
};

static void regi_icp_set_free(const sb_allocator *allocator, regi_icp_set *set)
{
    sbi_free(allocator, set->points);
    sbi_free(allocator, set->normals);
    sbi_free(allocator, set->weights);
    sbi_free(allocator, set->partner);
}

REGI_API void regi_icp_side_free(const sb_allocator *allocator, regi_icp_side *side)
{
    reg_kdtree_destroy(side->own_tree);
    reg_kdtree_destroy(side->spread_tree);
    reg_cloud_free(&side->own);
    sbi_free(allocator, side->own_weights);
    regi_icp_set_free(allocator, &side->sample);
    regi_icp_set_free(allocator, &side->spread);
}

REGI_API sb_result regi_icp_no_memory(const regi_icp *icp)
{
    return sbi_fail(icp->error, SB_ERROR_MEMORY, "no memory to align the shapes");
}

static int regi_icp_set_allocate(const sb_allocator *allocator, regi_icp_set *set, int count)
{
    set->count = count;
    set->points = (sb_vec3 *)sbi_alloc(allocator, (size_t)count, sizeof(sb_vec3));
    set->normals = (sb_vec3 *)sbi_alloc(allocator, (size_t)count, sizeof(sb_vec3));
    set->weights = (sb_real *)sbi_alloc(allocator, (size_t)count, sizeof(sb_real));
    set->partner = (int *)sbi_alloc_zeroed(allocator, (size_t)count, sizeof(int));
    return set->points && set->normals && set->weights && set->partner;
}

/* Every so-maniest point in the order of the tree, in which neighbours are neighbours: indices[wanted],
 * wanted <= count. 0 without memory. */
static int regi_icp_stride(const regi_icp *icp, const regi_icp_side *side, int wanted, int *indices)
{
    int *order = (int *)sbi_alloc(icp->allocator, (size_t)side->count, sizeof(int));
    if (!order)
        return 0;
    regi_kdtree_order(side->tree, order);
    for (int i = 0; i < wanted; i++)
        indices[i] = order[(int64_t)i * side->count / wanted];
    sbi_free(icp->allocator, order);
    return 1;
}

REGI_API sb_real regi_icp_weight(const regi_icp_side *side, int point)
{
    sb_real weight = side->weights ? side->weights[point] : 1, sure;
    if (!side->sd)
        return weight;
    sure = side->usual_sd / side->sd[point];
    return weight * sb_min(sure * sure, 1 / SB_EPSILON);
}

/* How many of the side's points are where this one is, itself included; 16 at most. */
static int regi_icp_copies(const regi_icp_side *side, int point)
{
    int indices[16], found = 0;
    sb_real squared[16];
    for (int k = 2; k <= 16; k *= 8) { /* few have any */
        found = reg_kdtree_k_nearest(side->tree, side->points[point], k, indices, squared);
        while (found > 1 && squared[found - 1] > 0)
            found--;
        if (found < k)
            break;
    }
    return sbi_max_int(found, 1);
}

/* The side's points chosen[count] (NULL: the first ones) as a set. */
static sb_result regi_icp_take(const regi_icp *icp, const regi_icp_side *side, const int *chosen, int count,
                               regi_icp_set *set)
{
    if (!regi_icp_set_allocate(icp->allocator, set, count))
        return regi_icp_no_memory(icp);
    for (int i = 0; i < count; i++) {
        int at = chosen ? chosen[i] : i;
        set->points[i] = side->points[at];
        set->normals[i] = sb_v3_scale((sb_real)side->sign, side->normals[at]);
        set->weights[i] = regi_icp_weight(side, at) / (sb_real)regi_icp_copies(side, at);
    }
    return SB_OK;
}

/* The points that look in the last stage: as dense as the shape's own. */
static sb_result regi_icp_sample(const regi_icp *icp, const regi_icp_side *side, int wanted, regi_icp_set *set)
{
    int *chosen;
    sb_result result;
    if (wanted >= side->count)
        return regi_icp_take(icp, side, NULL, side->count, set);
    chosen = (int *)sbi_alloc(icp->allocator, (size_t)wanted, sizeof(int));
    result = chosen && regi_icp_stride(icp, side, wanted, chosen) ? regi_icp_take(icp, side, chosen, wanted, set)
                                                                  : regi_icp_no_memory(icp);
    sbi_free(icp->allocator, chosen);
    return result;
}

/* ---- isolated points ------------------------------------------------------------------------------------------------
 * Farthest points are chosen first where points are spread: outliers before all others. So they go before. */

/* Of points[count] (at least one): the distance to the ninth neighbour (infinite where all are in one place), and
 * (normals not NULL) the mean normal of all of these, into smooth[count]: normals of noisy facets are none, those of a
 * patch are. */
static sb_result regi_icp_neighbours(const regi_icp *icp, const sb_vec3 *points, const sb_vec3 *normals, int count,
                                     sb_real *reach, sb_vec3 *smooth)
{
    int indices[REGI_ICP_NEAR + 1];
    sb_real squared[REGI_ICP_NEAR + 1];
    reg_kdtree *tree = NULL;
    sb_result result = reg_kdtree_create(points, count, icp->allocator, &tree, icp->error);
    for (int i = 0; result == SB_OK && i < count; i++) {
        int found = reg_kdtree_k_nearest(tree, points[i], REGI_ICP_NEAR + 1, indices, squared);
        sb_vec3 sum = sb_v3(0, 0, 0);
        reach[i] = found > 0 && squared[found - 1] > 0 ? sb_sqrt(squared[found - 1]) : (sb_real)INFINITY;
        for (int k = 0; normals && k < found; k++)
            sum = sb_v3_add(sum, normals[indices[k]]);
        if (normals) /* both sides of a thin part, or no direction at all: better the point's own */
            smooth[i] = sb_v3_norm(sum) > (sb_real)0.3 * (sb_real)found ? regi_cloud_unit(sum) : normals[i];
    }
    reg_kdtree_destroy(tree);
    return result;
}

/* Leaves of chosen[count] those whose reach is at most three medians; smooth[count] (or NULL) goes with them. Returns
 * how many. */
static int regi_icp_keep_near(int *chosen, sb_vec3 *points, sb_vec3 *smooth, const sb_real *reach, int count,
                              sb_real *scratch)
{
    sb_real limit = 3 * reg_outlier_limit(reach, count, REG_OUTLIERS_TRIM, (sb_real)0.5, scratch);
    int kept = 0;
    for (int i = 0; i < count; i++)
        if (reach[i] <= limit || !sb_is_finite(reach[i])) {
            chosen[kept] = chosen[i];
            points[kept] = points[i];
            if (smooth)
                smooth[kept] = smooth[i];
            kept++;
        }
    return kept;
}

/* What the search's points are chosen from. */
typedef struct regi_icp_crowd {
    int *chosen; /* [count] of the side's points */
    sb_vec3 *points, *normals;
    sb_real *reach, *scratch;
    int count;
} regi_icp_crowd;

static int regi_icp_crowd_allocate(const regi_icp *icp, regi_icp_crowd *crowd, int count)
{
    size_t n = (size_t)count;
    crowd->count = count;
    crowd->chosen = (int *)sbi_alloc(icp->allocator, n, 2 * sizeof(int));
    crowd->points = (sb_vec3 *)sbi_alloc(icp->allocator, n, 3 * sizeof(sb_vec3));
    crowd->reach = (sb_real *)sbi_alloc(icp->allocator, n, 2 * sizeof(sb_real));
    crowd->normals = crowd->points + n;
    crowd->scratch = crowd->reach + n;
    return crowd->chosen && crowd->points && crowd->reach;
}

static void regi_icp_crowd_free(const regi_icp *icp, regi_icp_crowd *crowd)
{
    sbi_free(icp->allocator, crowd->chosen);
    sbi_free(icp->allocator, crowd->points);
    sbi_free(icp->allocator, crowd->reach);
}

/* The side's points without those of weight 0 and, but for a closed surface, isolated ones; normals smoothed. */
static sb_result regi_icp_gather(const regi_icp *icp, const regi_icp_side *side, regi_icp_crowd *crowd)
{
    sb_result result = SB_OK;
    int weighed = 0;
    if (!regi_icp_stride(icp, side, crowd->count, crowd->chosen))
        return regi_icp_no_memory(icp);
    for (int i = 0; i < crowd->count; i++)
        if (regi_icp_weight(side, crowd->chosen[i]) > 0)
            crowd->chosen[weighed++] = crowd->chosen[i];
    crowd->count = weighed > 0 ? weighed : crowd->count;
    for (int i = 0; i < crowd->count; i++) {
        crowd->points[i] = side->points[crowd->chosen[i]];
        crowd->normals[i] = side->normals[crowd->chosen[i]];
    }
    if (!side->closed && !side->cleaned) {
        sb_vec3 *smooth = crowd->normals + crowd->count;
        result = regi_icp_neighbours(icp, crowd->points, crowd->normals, crowd->count, crowd->reach, smooth);
        if (result == SB_OK) {
            memcpy(crowd->normals, smooth, (size_t)crowd->count * sizeof(sb_vec3));
            crowd->count = regi_icp_keep_near(crowd->chosen, crowd->points, crowd->normals, crowd->reach, crowd->count,
                                              crowd->scratch);
        }
    }
    return result;
}

/* The points of the search, evenly spread whatever the shape's density, out of four times as many. */
static sb_result regi_icp_spread(const regi_icp *icp, const regi_icp_side *side, regi_icp_set *set)
{
    regi_icp_crowd crowd;
    sb_result result = regi_icp_crowd_allocate(icp, &crowd, sbi_min_int(side->count, REGI_ICP_CROWD))
                           ? regi_icp_gather(icp, side, &crowd)
                           : regi_icp_no_memory(icp);
    if (result == SB_OK) {
        int *best = crowd.chosen + crowd.count;
        int count =
            reg_cloud_spread(crowd.points, crowd.count, sbi_min_int(crowd.count, REGI_ICP_FINE), best, crowd.scratch);
        if (!regi_icp_set_allocate(icp->allocator, set, count))
            result = regi_icp_no_memory(icp);
        for (int i = 0; result == SB_OK && i < count; i++) {
            set->points[i] = crowd.points[best[i]];
            set->normals[i] = sb_v3_scale((sb_real)side->sign, crowd.normals[best[i]]);
            set->weights[i] = regi_icp_weight(side, crowd.chosen[best[i]]);
        }
    }
    regi_icp_crowd_free(icp, &crowd);
    return result;
}

/* ---- normals ----------------------------------------------------------------------------------------------------- */

/* The side becomes its points chosen[count], with memory of its own. */
static sb_result regi_icp_own(const regi_icp *icp, regi_icp_side *side, const int *chosen, int count)
{
    reg_kdtree *tree = NULL;
    sb_result result = regi_cloud_allocate(&side->own, count, 0, icp->allocator, icp->error);
    if (result == SB_OK) {
        side->own_weights = (sb_real *)sbi_alloc(icp->allocator, (size_t)count, sizeof(sb_real));
        result = side->own_weights ? SB_OK : regi_icp_no_memory(icp);
    }
    for (int i = 0; result == SB_OK && i < count; i++) {
        side->own.points[i] = side->points[chosen[i]];
        side->own_weights[i] = regi_icp_weight(side, chosen[i]);
    }
    if (result == SB_OK)
        result = reg_kdtree_create(side->own.points, count, icp->allocator, &tree, icp->error);
    if (result != SB_OK)
        return result;
    reg_kdtree_destroy(side->own_tree);
    side->own_tree = tree;
    side->tree = tree;
    side->points = side->own.points;
    side->weights = side->own_weights;
    side->sd = NULL;
    side->count = count;
    return SB_OK;
}

/* The side's points in their order, of several in one place the first: chosen[side->count]. Returns how many. */
static int regi_icp_places(const regi_icp_side *side, int *chosen)
{
    int count = 0;
    for (int i = 0; i < side->count; i++)
        if (reg_kdtree_nearest(side->tree, side->points[i], SB_REAL_MAX, NULL) == i)
            chosen[count++] = i;
    return count;
}

/* Where normals have to be fitted: to fewer points when there are very many, and without isolated ones. */
static sb_result regi_icp_reduce(const regi_icp *icp, regi_icp_side *side)
{
    regi_icp_crowd crowd;
    sb_result result = regi_icp_crowd_allocate(icp, &crowd, sbi_min_int(side->count, REGI_ICP_FITTED)) &&
                               regi_icp_stride(icp, side, crowd.count, crowd.chosen)
                           ? SB_OK
                           : regi_icp_no_memory(icp);
    if (result == SB_OK) {
        if (crowd.count == side->count)
            crowd.count = regi_icp_places(side, crowd.chosen);
        for (int i = 0; i < crowd.count; i++)
            crowd.points[i] = side->points[crowd.chosen[i]];
        result = regi_icp_neighbours(icp, crowd.points, NULL, crowd.count, crowd.reach, NULL);
    }
    if (result == SB_OK) {
        int kept = regi_icp_keep_near(crowd.chosen, crowd.points, NULL, crowd.reach, crowd.count, crowd.scratch);
        result = regi_icp_own(icp, side, crowd.chosen, kept);
        side->cleaned = 1;
    }
    regi_icp_crowd_free(icp, &crowd);
    return result;
}

/* Normals across planes through neighbours: towards the camera, else either way. */
static sb_result regi_icp_fit_normals(const regi_icp *icp, const reg_icp_shape *shape, regi_icp_side *side)
{
    sb_result result = regi_icp_reduce(icp, side);
    side->surface = NULL;
    side->fitted = 1;
    side->unsure = !shape->has_camera;
    if (result == SB_OK)
        result = reg_cloud_estimate_normals(&side->own, REGI_ICP_NEIGHBOURS, shape->has_camera ? &shape->camera : NULL,
                                            NULL, icp->error);
    side->normals = side->own.normals;
    return result;
}

static sb_result regi_icp_surface_normals(const regi_icp *icp, regi_icp_side *side)
{
    sb_result result = regi_cloud_allocate(&side->own, side->count, 1, icp->allocator, icp->error);
    for (int i = 0; result == SB_OK && i < side->count; i++) {
        sb_surface_hit hit;
        sb_surface_closest(side->surface, side->points[i], SB_REAL_MAX, &hit);
        side->own.normals[i] = sb_surface_normal(side->surface, &hit);
    }
    side->normals = side->own.normals;
    return result;
}

/* -1 when a closed surface's normals point inwards: what is seen of it from far outside, on six sides, looks away. */
static int regi_icp_outward(const sb_surface *surface)
{
    sb_vec3 low, high, middle;
    sb_real far_off;
    int votes = 0;
    sb_surface_bounds(surface, &low, &high);
    middle = sb_v3_scale((sb_real)0.5, sb_v3_add(low, high));
    far_off = 2 * sb_v3_norm(sb_v3_sub(high, low));
    for (int i = 0; i < 6; i++) {
        sb_real step = i % 2 ? far_off : -far_off, towards;
        sb_vec3 from = sb_v3_add(middle, sb_v3(i / 2 == 0 ? step : 0, i / 2 == 1 ? step : 0, i / 2 == 2 ? step : 0));
        sb_surface_hit hit;
        if (!sb_surface_closest(surface, from, SB_REAL_MAX, &hit))
            continue;
        towards = sb_v3_dot(sb_surface_normal(surface, &hit), sb_v3_sub(from, hit.point));
        votes += towards > 0 ? 1 : towards < 0 ? -1 : 0;
    }
    return votes < 0 ? -1 : 1;
}

/* Normals that a cloud brings, as means over neighbours where they are noisy: half of them over 15 degrees off these
 * means. Of very many points they are taken as they are. */
static sb_result regi_icp_smooth_normals(const regi_icp *icp, regi_icp_side *side)
{
    const sb_real even = (sb_real)0.034;
    sb_real *reach;
    sb_result result;
    if (side->surface || side->count > REGI_ICP_FITTED)
        return SB_OK;
    result = regi_cloud_allocate(&side->own, side->count, 1, icp->allocator, icp->error);
    if (result != SB_OK)
        return result;
    reach = (sb_real *)sbi_alloc(icp->allocator, (size_t)side->count, 2 * sizeof(sb_real));
    result = reach ? regi_icp_neighbours(icp, side->points, side->normals, side->count, reach, side->own.normals)
                   : regi_icp_no_memory(icp);
    if (result == SB_OK) {
        for (int i = 0; i < side->count; i++)
            reach[i] = 1 - sb_v3_dot(side->normals[i], side->own.normals[i]);
        if (reg_outlier_limit(reach, side->count, REG_OUTLIERS_TRIM, (sb_real)0.5, reach + side->count) > even)
            side->normals = side->own.normals;
    }
    sbi_free(icp->allocator, reach);
    return result;
}

/* Share of the normals that look away from the camera. */
static sb_real regi_icp_away(const regi_icp_side *side, sb_vec3 camera)
{
    int away = 0, known = 0;
    for (int i = 0; i < side->count; i++) {
        sb_real towards = sb_v3_dot(side->normals[i], sb_v3_sub(camera, side->points[i]));
        known += towards < 0 || towards > 0;
        away += towards < 0;
    }
    return known > 0 ? (sb_real)away / (sb_real)known : (sb_real)0.5;
}

/* Normals, and which way they point: a closed surface has an outside, a camera sees outsides only; else both ways are
 * tried. */
static sb_result regi_icp_normals(regi_icp *icp, const reg_icp_shape *shape, regi_icp_side *side)
{
    const sb_real few = (sb_real)0.1;
    sb_result result = SB_OK;
    sb_real away;
    side->sign = 1;
    side->closed = side->surface && sb_surface_is_closed(side->surface);
    if (!side->normals && !side->surface)
        return regi_icp_fit_normals(icp, shape, side);
    if (!side->normals)
        result = regi_icp_surface_normals(icp, side);
    if (result != SB_OK)
        return result;
    if (side->closed) {
        side->sign = regi_icp_outward(side->surface);
    } else if (shape->has_camera) {
        away = regi_icp_away(side, shape->camera);
        side->sign = away >= 1 - few ? -1 : 1;
        if (away > few && away < 1 - few) {
            icp->warnings |= REG_WARN_MIXED_NORMALS;
            reg_cloud_free(&side->own);
            return regi_icp_fit_normals(icp, shape, side);
        }
    } else {
        side->unsure = 1;
    }
    if (side->sign < 0)
        icp->warnings |= REG_WARN_INVERTED;
    return regi_icp_smooth_normals(icp, side);
}

/* Centre, size and principal axes of the evenly spread points. An axis has no direction of its own: it gets the one in
 * which the points reach farther (the sign of the third moment), so that the axes turn with the shape. */
static void regi_icp_principal_axes(regi_icp_side *side)
{
    const regi_icp_set *set = &side->spread;
    sb_mat3 spread = sb_m3_zero();
    sb_vec3 skew = sb_v3(0, 0, 0), axis[3];
    side->centre = sb_v3(0, 0, 0);
    for (int i = 0; i < set->count; i++)
        side->centre = sb_v3_madd(side->centre, 1 / (sb_real)(i + 1), sb_v3_sub(set->points[i], side->centre));
    for (int i = 0; i < set->count; i++) {
        sb_vec3 d = sb_v3_sub(set->points[i], side->centre);
        spread = sb_m3_add(spread, sb_m3_outer(sb_v3_scale(1 / (sb_real)set->count, d), d));
    }
    side->size = sb_sqrt(sb_max(sb_m3_trace(spread), 0));
    sb_m3_eigen(spread, NULL, &side->axes);
    for (int i = 0; i < set->count && side->size > 0; i++) {
        sb_vec3 d = sb_m3_tapply(side->axes, sb_v3_scale(1 / side->size, sb_v3_sub(set->points[i], side->centre)));
        skew = sb_v3_add(skew, sb_v3(d.x * d.x * d.x, d.y * d.y * d.y, d.z * d.z * d.z));
    }
    axis[0] = sb_v3_scale(skew.x < 0 ? -1 : 1, sb_m3_column(side->axes, 0));
    axis[1] = sb_v3_scale(skew.y < 0 ? -1 : 1, sb_m3_column(side->axes, 1));
    axis[2] = sb_v3_cross(axis[0], axis[1]);
    side->axes = sb_m3_columns(axis[0], axis[1], axis[2]);
}

/* Extent, area and spacing. Evenly spread points have a neighbour at d in every 0.75 d^2 or so of their surface. */
static void regi_icp_measure_side(regi_icp_side *side)
{
    const regi_icp_set *set = &side->spread;
    sb_vec3 low = set->points[0], high = low;
    int pair[2];
    sb_real squared[2], share;
    side->area = 0;
    for (int i = 0; i < set->count; i++) {
        sb_vec3 p = set->points[i];
        low = sb_v3(sb_min(low.x, p.x), sb_min(low.y, p.y), sb_min(low.z, p.z));
        high = sb_v3(sb_max(high.x, p.x), sb_max(high.y, p.y), sb_max(high.z, p.z));
        if (reg_kdtree_k_nearest(side->spread_tree, p, 2, pair, squared) == 2)
            side->area += (sb_real)0.75 * squared[1];
    }
    side->extent = sb_v3_norm(sb_v3_sub(high, low));
    share = side->area / (sb_real)side->count;
    side->spacing = sb_sqrt(sb_max(share, 0));
}

REGI_API reg_rigid regi_icp_of_model(const regi_icp *icp, const reg_rigid *motion)
{
    return icp->swapped ? reg_rigid_inverse(motion) : *motion;
}

REGI_API sb_vec3 regi_icp_facing(const regi_icp_set *set)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int i = 0; i < set->count; i++)
        sum = sb_v3_add(sum, set->normals[i]);
    return sb_v3_scale(1 / (sb_real)set->count, sum);
}

static sb_result regi_icp_usual_sd(const regi_icp *icp, regi_icp_side *side)
{
    sb_real *scratch;
    side->usual_sd = 1;
    if (!side->sd)
        return SB_OK;
    scratch = (sb_real *)sbi_alloc(icp->allocator, (size_t)side->count, sizeof(sb_real));
    if (!scratch)
        return regi_icp_no_memory(icp);
    side->usual_sd = reg_outlier_limit(side->sd, side->count, REG_OUTLIERS_TRIM, (sb_real)0.5, scratch);
    sbi_free(icp->allocator, scratch);
    return SB_OK;
}

REGI_API sb_result regi_icp_side_make(regi_icp *icp, const reg_icp_shape *shape, regi_icp_side *side)
{
    sb_result result = SB_OK;
    side->points = shape->points;
    side->normals = shape->normals;
    side->weights = shape->weights;
    side->sd = shape->sd;
    side->count = shape->count;
    side->surface = shape->surface;
    side->tree = shape->tree;
    if (!side->tree) {
        result = reg_kdtree_create(shape->points, shape->count, icp->allocator, &side->own_tree, icp->error);
        side->tree = side->own_tree;
    }
    if (result == SB_OK)
        result = regi_icp_usual_sd(icp, side);
    if (result == SB_OK)
        result = regi_icp_normals(icp, shape, side);
    if (result == SB_OK)
        result =
            regi_icp_sample(icp, side, icp->options->sample > 0 ? icp->options->sample : side->count, &side->sample);
    if (result == SB_OK)
        result = regi_icp_spread(icp, side, &side->spread);
    if (result == SB_OK)
        result =
            reg_kdtree_create(side->spread.points, side->spread.count, icp->allocator, &side->spread_tree, icp->error);
    if (result == SB_OK) {
        regi_icp_principal_axes(side);
        regi_icp_measure_side(side);
    }
    return result;
}

/* ==== src/register/icp_step.c ==== */
/* icp_step: pairs, fits and the iteration. */

enum { REGI_ICP_PATIENCE = 10 }; /* rounds without a smaller mean distance */

/* ==== pairs ======================================================================================================= */

/* The point of a side closest to p within `reach`, with its normal and weight; 0 when there is none. *partner: where to
 * look first, and then what was found. */
static int regi_icp_closest(const regi_icp_side *side, int coarse, sb_vec3 p, sb_real reach, int *partner,
                            sb_vec3 *point, sb_vec3 *normal, sb_real *weight, sb_real *distance)
{
    const sb_vec3 *points = coarse ? side->spread.points : side->points;
    sb_vec3 guess;
    sb_real squared;
    int at;
    if (!coarse && side->surface) {
        sb_surface_hit hit;
        if (!sb_surface_closest_from(side->surface, p, reach, *partner, &hit))
            return 0;
        *partner = hit.triangle;
        *point = hit.point;
        *normal = sb_v3_scale((sb_real)side->sign, sb_surface_normal(side->surface, &hit));
        *weight = 1;
        *distance = hit.distance;
        if (!side->weights && !side->sd)
            return 1;
        at = reg_kdtree_nearest(side->tree, hit.point, SB_REAL_MAX, NULL);
        *weight = regi_icp_weight(side, at);
        return 1;
    }
    guess = sb_v3_sub(points[*partner], p);
    squared = sb_v3_dot(guess, guess);
    if (!sb_is_finite(squared))
        return 0;
    at = *partner = regi_kdtree_nearest_from(coarse ? side->spread_tree : side->tree, p, *partner, &squared);
    if (sb_sqrt(squared) > reach)
        return 0;
    *point = points[at];
    *normal = coarse ? side->spread.normals[at] : sb_v3_scale((sb_real)side->sign, side->normals[at]);
    *weight = coarse ? side->spread.weights[at] : regi_icp_weight(side, at);
    *distance = sb_sqrt(squared);
    return 1;
}

/* Pairs of the set's points with their closest ones, appended; weights 0 where there is none, or where the normals
 * contradict. motion: of the set's side onto the other. `back`: the set is b's. Returns the sum of min(distance, lost),
 * weighted. */
static void regi_icp_look(regi_icp *icp, const regi_icp_stage *stage, const reg_rigid *motion, int back)
{
    const regi_icp_set *set =
        stage->spread ? (back ? &icp->b.spread : &icp->a.spread) : (back ? &icp->b.sample : &icp->a.sample);
    const regi_icp_side *other = back ? &icp->a : &icp->b;
    regi_icp_pairs *pairs = &icp->pairs;
    int count = sbi_min_int(set->count, stage->points);
    for (int i = 0; i < count; i++, pairs->count++) {
        int n = pairs->count;
        sb_vec3 point, normal;
        sb_real weight = 0, distance = 0;
        pairs->weight[n] = 0;
        pairs->distance[n] = (sb_real)INFINITY;
        pairs->from[n] = pairs->to[n] = pairs->normal[n] = sb_v3(0, 0, 0);
        if (!regi_icp_closest(other, stage->coarse, reg_rigid_apply(motion, set->points[i]), stage->reach,
                              set->partner + i, &point, &normal, &weight, &distance))
            continue;
        if ((sb_real)stage->flip * sb_v3_dot(normal, sb_m3_apply(motion->rotation, set->normals[i])) < 0)
            continue;
        pairs->from[n] = back ? point : set->points[i];
        pairs->to[n] = back ? set->points[i] : point;
        pairs->normal[n] = back ? sb_m3_tapply(motion->rotation, normal) : normal;
        pairs->weight[n] = weight * set->weights[i];
        pairs->distance[n] = distance;
    }
}

/* Weights 0 for the outliers among pairs first..count. Returns the sum of min(distance, lost) of all. */
static sb_real regi_icp_prune(regi_icp_pairs *pairs, int first, const regi_icp_stage *stage)
{
    int count = pairs->count - first;
    sb_real limit =
                reg_outlier_limit(pairs->distance + first, count, stage->outliers, stage->parameter, pairs->scratch),
            sum = 0;
    for (int i = first; i < pairs->count; i++) {
        if (!(pairs->distance[i] <= limit))
            pairs->weight[i] = 0;
        sum += sb_min(pairs->distance[i], stage->lost);
    }
    return count > 0 ? sum / (sb_real)count : 0;
}

REGI_API sb_real regi_icp_pair(regi_icp *icp, const regi_icp_stage *stage, const reg_rigid *motion)
{
    sb_real score, share = 1, first;
    icp->pairs.count = 0;
    regi_icp_look(icp, stage, motion, 0);
    score = regi_icp_prune(&icp->pairs, 0, stage);
    if (icp->both) {
        reg_rigid back = reg_rigid_inverse(motion);
        int forward = icp->pairs.count;
        regi_icp_look(icp, stage, &back, 1);
        first = score;
        score = (first + regi_icp_prune(&icp->pairs, forward, stage)) / 2;
    }
    for (int i = 0; i < icp->options->landmark_count; i++) {
        sb_vec3 gap = sb_v3_sub(reg_rigid_apply(motion, icp->landmarks_a[i]), icp->landmarks_b[i]);
        score += icp->options->landmarks[i].weight * sb_v3_norm(gap);
        share += icp->options->landmarks[i].weight;
    }
    return score / share;
}

/* ==== fits ======================================================================================================== */

static void regi_icp_add_row(regi_icp_system *system, sb_vec3 arm, sb_vec3 normal, sb_real gap, sb_real weight)
{
    sb_vec3 turn = sb_v3_cross(arm, normal);
    sb_real row[6];
    row[0] = turn.x, row[1] = turn.y, row[2] = turn.z;
    row[3] = normal.x, row[4] = normal.y, row[5] = normal.z;
    for (int i = 0; i < 6; i++) {
        for (int j = 0; j <= i; j++)
            system->matrix[i][j] += weight * row[i] * row[j];
        system->right[i] -= weight * row[i] * gap;
    }
}

REGI_API void regi_icp_solve(regi_icp_system *system)
{
    sb_real(*m)[6] = system->matrix, *x = system->right;
    for (int i = 0; i < 6; i++)
        for (int j = 0; j <= i; j++) {
            sb_real sum = m[i][j];
            for (int k = 0; k < j; k++)
                sum -= m[i][k] * m[j][k];
            m[i][j] = i == j ? sb_sqrt(sb_max(sum, SB_EPSILON * SB_EPSILON)) : sum / m[j][j];
        }
    for (int i = 0; i < 6; i++) {
        for (int k = 0; k < i; k++)
            x[i] -= m[i][k] * x[k];
        x[i] /= m[i][i];
    }
    for (int i = 5; i >= 0; i--) {
        for (int k = i + 1; k < 6; k++)
            x[i] -= m[k][i] * x[k];
        x[i] /= m[i][i];
    }
}

REGI_API void regi_icp_equations(const regi_icp *icp, const reg_rigid *motion, int at_planes, regi_icp_system *system)
{
    const regi_icp_pairs *pairs = &icp->pairs;
    sb_real size = icp->a.size > 0 ? icp->a.size : 1, total = 0;
    sb_vec3 centre = reg_rigid_apply(motion, icp->a.centre);
    memset(system, 0, sizeof *system);
    for (int i = 0; i < pairs->count; i++) {
        sb_vec3 x, gap;
        if (!(pairs->weight[i] > 0))
            continue;
        x = reg_rigid_apply(motion, pairs->from[i]);
        gap = sb_v3_scale(1 / size, sb_v3_sub(x, pairs->to[i]));
        total += pairs->weight[i];
        regi_icp_add_row(system, sb_v3_scale(1 / size, sb_v3_sub(at_planes ? pairs->to[i] : x, centre)),
                         pairs->normal[i], sb_v3_dot(pairs->normal[i], gap), pairs->weight[i]);
    }
    for (int i = 0; i < icp->options->landmark_count; i++) {
        sb_vec3 x = reg_rigid_apply(motion, icp->landmarks_a[i]);
        sb_vec3 arm = sb_v3_scale(1 / size, sb_v3_sub(x, centre));
        sb_vec3 gap = sb_v3_scale(1 / size, sb_v3_sub(x, icp->landmarks_b[i]));
        sb_real weight = total * icp->options->landmarks[i].weight;
        regi_icp_add_row(system, arm, sb_v3(1, 0, 0), gap.x, weight);
        regi_icp_add_row(system, arm, sb_v3(0, 1, 0), gap.y, weight);
        regi_icp_add_row(system, arm, sb_v3(0, 0, 1), gap.z, weight);
    }
}

/* One Gauss-Newton step to the planes; a damping of a millionth holds what they leave open. */
static void regi_icp_fit_planes(const regi_icp *icp, reg_rigid *motion)
{
    regi_icp_system system;
    sb_real size = icp->a.size > 0 ? icp->a.size : 1, trace = 0, angle;
    sb_vec3 centre = reg_rigid_apply(motion, icp->a.centre), shift, turn;
    reg_rigid step;
    regi_icp_equations(icp, motion, 0, &system);
    for (int i = 0; i < 6; i++)
        trace += system.matrix[i][i];
    for (int i = 0; i < 6; i++)
        system.matrix[i][i] += (sb_real)1e-6 * trace;
    regi_icp_solve(&system);
    turn = sb_v3(system.right[0], system.right[1], system.right[2]);
    angle = sb_v3_norm(turn);
    if (angle > (sb_real)0.5) /* linearised: far turns are not to be trusted */
        turn = sb_v3_scale((sb_real)0.5 / angle, turn);
    shift = sb_v3_scale(size, sb_v3(system.right[3], system.right[4], system.right[5]));
    step.rotation = sb_quat_to_mat3(sb_quat_from_rotation_vector(turn));
    step.translation = sb_v3_add(sb_v3_sub(centre, sb_m3_apply(step.rotation, centre)), shift);
    *motion = reg_rigid_compose(&step, motion);
}

/* Kabsch's fit of the pairs and, behind them in the same arrays, the landmarks. */
static void regi_icp_fit_points(const regi_icp *icp, reg_rigid *motion)
{
    const regi_icp_pairs *pairs = &icp->pairs;
    sb_real total = 0;
    int count = pairs->count;
    for (int i = 0; i < pairs->count; i++)
        total += pairs->weight[i];
    for (int i = 0; i < icp->options->landmark_count; i++, count++) {
        pairs->from[count] = icp->landmarks_a[i];
        pairs->to[count] = icp->landmarks_b[i];
        pairs->weight[count] = total * icp->options->landmarks[i].weight;
    }
    reg_rigid_fit(pairs->from, pairs->to, pairs->weight, count, motion, NULL);
}

/* Products of many rotations drift off: back to the nearest one. */
static void regi_icp_clean(reg_rigid *motion)
{
    motion->rotation = sb_quat_to_mat3(sb_quat_from_mat3(motion->rotation));
}

REGI_API int regi_icp_measure(const regi_icp_pairs *pairs, sb_real *mean, sb_real *rms)
{
    sb_real total = 0, sum = 0, squares = 0;
    int count = 0;
    for (int i = 0; i < pairs->count; i++) {
        sb_real w = pairs->weight[i];
        if (!(w > 0))
            continue;
        total += w;
        sum += w * pairs->distance[i];
        squares += w * pairs->distance[i] * pairs->distance[i];
        count++;
    }
    *mean = count > 0 ? sum / total : 0;
    *rms = count > 0 ? sb_sqrt(squares / total) : 0;
    return count;
}

static int regi_icp_late(regi_icp *icp)
{
    const reg_icp_options *options = icp->options;
    if (!icp->out_of_time && options->clock && options->clock() - icp->begun >= options->max_seconds)
        icp->out_of_time = 1;
    return icp->out_of_time;
}

REGI_API int regi_icp_iterate(regi_icp *icp, const regi_icp_stage *stage, int rounds, sb_real tolerance,
                              reg_rigid *motion, sb_real *score, int *converged)
{
    sb_real mean = 0, rms, before, best;
    int round = 0, idle = 0;
    *converged = 0;
    *score = regi_icp_pair(icp, stage, motion);
    if (regi_icp_measure(&icp->pairs, &before, &rms) == 0)
        return 0;
    for (best = before; round < rounds && !*converged; before = mean) {
        if (regi_icp_late(icp))
            break;
        if (stage->metric == REG_ICP_PLANE)
            regi_icp_fit_planes(icp, motion);
        else
            regi_icp_fit_points(icp, motion);
        regi_icp_clean(motion);
        *score = regi_icp_pair(icp, stage, motion);
        round++;
        if (regi_icp_measure(&icp->pairs, &mean, &rms) == 0)
            break;
        /* pairs may also change to and fro for ever */
        idle = mean < best * (1 - tolerance) ? 0 : idle + 1;
        best = sb_min(best, mean);
        *converged = sb_abs(mean - before) <= tolerance * before || idle == REGI_ICP_PATIENCE;
    }
    return round;
}

/* ==== src/register/pose_view.c ==== */
/* pose_view: what the caller knows of a pose: a rough start, from where the organ was seen, and that nothing was in
 * front of what the camera saw. */

/* Where the target looks, in its frame; flip -1: its normals point inwards. */
static sb_vec3 regi_pose_view(const regi_icp *icp, int flip)
{
    const regi_icp_side *target = icp->swapped ? &icp->a : &icp->b;
    if (icp->target->has_camera)
        return regi_cloud_unit(sb_v3_sub(icp->target->camera, target->centre));
    return sb_v3_scale((sb_real)flip, regi_cloud_unit(regi_icp_facing(&target->spread)));
}

static sb_real regi_pose_square(sb_real x, sb_real slack, sb_real sd)
{
    sb_real beyond = sb_max(x - slack, 0) / sd;
    return beyond * beyond;
}

REGI_API sb_real regi_pose_prior(const regi_icp *icp, const regi_pose *pose, sb_real slack)
{
    const reg_icp_options *o = icp->options;
    const regi_icp_side *model = icp->swapped ? &icp->b : &icp->a;
    reg_rigid motion = regi_icp_of_model(icp, &pose->motion);
    sb_real sum = 0;
    if (o->start_shift_sd > 0 && o->start_turn_sd > 0) {
        reg_rigid back = reg_rigid_inverse(&o->start), between = reg_rigid_compose(&motion, &back);
        sb_real shift =
            sb_v3_norm(sb_v3_sub(reg_rigid_apply(&motion, model->centre), reg_rigid_apply(&o->start, model->centre)));
        sum += regi_pose_square(reg_rigid_angle(&between), slack, o->start_turn_sd);
        if (!(slack > 0))
            sum += regi_pose_square(shift, 0, o->start_shift_sd);
    }
    if (o->seen_from_sd > 0 && !icp->both) {
        sb_vec3 seen = sb_m3_tapply(motion.rotation, regi_pose_view(icp, pose->flip));
        sb_vec3 wanted = regi_cloud_unit(o->seen_from);
        sb_real angle = sb_atan2(sb_v3_norm(sb_v3_cross(seen, wanted)), sb_v3_dot(seen, wanted));
        sum += regi_pose_square(angle, slack, o->seen_from_sd);
    }
    return -sum / 2;
}

/* ==== free space ================================================================================================== */

enum { REGI_VIEW_CELLS = 32 }; /* along a side of the camera's image, at most */

/* What the camera saw of the target: the depth of the nearest point in each cell of an image. */
typedef struct regi_view {
    sb_vec3 camera, right, up, ahead;
    sb_real low[2], step[2];
    sb_real depth[REGI_VIEW_CELLS * REGI_VIEW_CELLS]; /* m; 0: nothing was seen there */
    int cells;
} regi_view;

/* A point's place in the image and its depth; 0 behind the camera. */
static int regi_view_project(const regi_view *view, sb_vec3 point, sb_real image[2], sb_real *depth)
{
    sb_vec3 ray = sb_v3_sub(point, view->camera);
    *depth = sb_v3_dot(ray, view->ahead);
    if (!(*depth > 0))
        return 0;
    image[0] = sb_v3_dot(ray, view->right) / *depth;
    image[1] = sb_v3_dot(ray, view->up) / *depth;
    return 1;
}

/* The cell of a place in the image, or -1 beside it. */
static int regi_view_cell(const regi_view *view, const sb_real image[2])
{
    int at[2];
    for (int k = 0; k < 2; k++) {
        sb_real cell = (image[k] - view->low[k]) / view->step[k];
        if (!(cell >= 0 && cell < (sb_real)view->cells))
            return -1;
        at[k] = (int)cell;
    }
    return at[1] * view->cells + at[0];
}

/* 0 where the camera's image has no size. */
static int regi_view_frame(const regi_icp_side *target, sb_vec3 camera, regi_view *view)
{
    sb_real high[2] = {-SB_REAL_MAX, -SB_REAL_MAX}, image[2], depth;
    view->camera = camera;
    view->ahead = regi_cloud_unit(sb_v3_sub(target->centre, camera));
    view->right = sb_v3_cross(view->ahead, sb_abs(view->ahead.x) < (sb_real)0.6 ? sb_v3(1, 0, 0) : sb_v3(0, 1, 0));
    view->right = regi_cloud_unit(view->right);
    view->up = sb_v3_cross(view->right, view->ahead);
    view->low[0] = view->low[1] = SB_REAL_MAX;
    for (int i = 0; i < target->spread.count; i++)
        for (int k = 0; k < 2 && regi_view_project(view, target->spread.points[i], image, &depth); k++) {
            view->low[k] = sb_min(view->low[k], image[k]);
            high[k] = sb_max(high[k], image[k]);
        }
    view->cells = sbi_min_int(REGI_VIEW_CELLS, (int)sb_sqrt((sb_real)target->spread.count / 3));
    for (int k = 0; k < 2; k++) /* a little more, so that the last point is inside */
        view->step[k] = (high[k] - view->low[k]) * (1 + 16 * SB_EPSILON) / (sb_real)sbi_max_int(view->cells, 1);
    return view->cells > 0 && view->step[0] > 0 && view->step[1] > 0 && sb_is_finite(view->step[0] + view->step[1]);
}

REGI_API sb_real regi_pose_in_front(const regi_icp *icp, const reg_rigid *motion)
{
    const regi_icp_side *target = icp->swapped ? &icp->a : &icp->b, *model = icp->swapped ? &icp->b : &icp->a;
    reg_rigid placed = regi_icp_of_model(icp, motion);
    sb_real image[2], depth, margin = (sb_real)0.02 * model->extent;
    regi_view view;
    int inside = 0, in_front = 0;
    if (!icp->target->has_camera || !regi_view_frame(target, icp->target->camera, &view))
        return 0;
    memset(view.depth, 0, sizeof view.depth);
    for (int i = 0; i < target->spread.count; i++) {
        int cell =
            regi_view_project(&view, target->spread.points[i], image, &depth) ? regi_view_cell(&view, image) : -1;
        if (cell >= 0 && (!(view.depth[cell] > 0) || depth < view.depth[cell]))
            view.depth[cell] = depth;
    }
    for (int i = 0; i < model->spread.count; i++) {
        sb_vec3 at = reg_rigid_apply(&placed, model->spread.points[i]);
        int cell = regi_view_project(&view, at, image, &depth) ? regi_view_cell(&view, image) : -1;
        if (cell < 0 || !(view.depth[cell] > 0))
            continue;
        inside++;
        in_front += depth < view.depth[cell] - margin;
    }
    return inside > 0 ? (sb_real)in_front / (sb_real)inside : 0;
}

/* ==== src/register/pose.c ==== */
/* pose: the search for poses, and how they are weighed. */

enum {
    REGI_POSE_ROTATIONS = 160, /* of the search, the turns of principal axes onto each other included */
    REGI_POSE_STAGES = 4,
    REGI_POSE_PROBES = 24 /* points that tell how far apart two poses are */
};

/* ==== candidates ================================================================================================== */

/* The i-th of n evenly spread rotations: super-Fibonacci spiral (Alexa 2022). */
static sb_mat3 regi_pose_spiral(int i, int n)
{
    const double pi2 = 6.283185307179586;
    double s = i + 0.5, r = sqrt(s / n), q = sqrt(1 - s / n);
    sb_real sa, ca, sb, cb;
    sb_sin_cos((sb_real)fmod(pi2 * s / 1.4142135623730951, pi2), &sa, &ca);
    sb_sin_cos((sb_real)fmod(pi2 * s / 1.533751168755204288, pi2), &sb, &cb);
    return sb_quat_to_mat3(
        sb_quat_normalise(sb_quat_make((sb_real)q * cb, (sb_real)r * sa, (sb_real)r * ca, (sb_real)q * sb)));
}

/* The i-th of the 24 turns of a cube onto itself; the first four keep the axes. */
static sb_mat3 regi_pose_cube(int i)
{
    static const unsigned char order[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    sb_mat3 turn = sb_m3_zero();
    int permutation = i / 4;
    for (int row = 0; row < 3; row++)
        turn.m[row][order[permutation][row]] = row < 2 ? (i >> row & 1 ? (sb_real)-1 : 1) : 1;
    if (sb_m3_det(turn) < 0)
        for (int column = 0; column < 3; column++)
            turn.m[2][column] = -turn.m[2][column];
    return turn;
}

/* A rotation with the translation that puts a's centre onto that of the part of b that looks a's way. */
static reg_rigid regi_pose_place(const regi_icp *icp, sb_mat3 rotation, sb_vec3 facing)
{
    const regi_icp_set *set = &icp->b.spread;
    sb_vec3 direction = sb_m3_apply(rotation, facing), seen = sb_v3(0, 0, 0);
    sb_real least = (sb_real)0.1 * sb_v3_norm(direction);
    reg_rigid motion;
    int count = 0;
    for (int i = 0; i < set->count && least > 0; i++)
        if (sb_v3_dot(set->normals[i], direction) > least)
            seen = sb_v3_madd(seen, 1 / (sb_real)++count, sb_v3_sub(set->points[i], seen));
    if (count == 0)
        seen = icp->b.centre;
    motion.rotation = rotation;
    motion.translation = sb_v3_sub(seen, sb_m3_apply(rotation, icp->a.centre));
    return motion;
}

static void regi_pose_add(regi_pose *poses, int *count, reg_rigid motion, int flip)
{
    memset(poses + *count, 0, sizeof poses[0]);
    poses[*count].motion = motion;
    poses[(*count)++].flip = flip;
}

/* All poses to try, after the caller's own and that of the landmarks; not those that the caller rules out by more than
 * three deviations. */
static int regi_pose_candidates(const regi_icp *icp, const reg_rigid *start, regi_pose *poses)
{
    const sb_real between_rotations = (sb_real)0.6; /* rad: the next of the spiral's is not farther off */
    const reg_icp_options *options = icp->options;
    int count = 0, spirals = REGI_POSE_ROTATIONS - 24, flips = icp->a.unsure || icp->b.unsure ? 2 : 1;
    sb_vec3 facing = icp->both ? sb_v3(0, 0, 0) : regi_icp_facing(&icp->a.spread);
    reg_rigid motion;
    for (int f = 0; f < flips; f++) {
        int flip = f ? -1 : 1;
        sb_vec3 way = sb_v3_scale((sb_real)flip, facing);
        regi_pose_add(poses, &count, *start, flip);
        if (options->landmark_count >= 3 &&
            reg_rigid_fit(icp->landmarks_a, icp->landmarks_b, NULL, options->landmark_count, &motion, NULL) == SB_OK)
            regi_pose_add(poses, &count, motion, flip);
        for (int i = 0; i < 24 + spirals; i++) {
            sb_mat3 turn = i < 24 ? regi_pose_cube(i) : regi_pose_spiral(i - 24, spirals);
            turn = sb_m3_mult(sb_m3_mul(icp->b.axes, turn), icp->a.axes);
            regi_pose_add(poses, &count, regi_pose_place(icp, turn, way), flip);
            if (regi_pose_prior(icp, poses + count - 1, between_rotations) < (sb_real)-4.5)
                count--;
        }
    }
    return count;
}

/* ==== distinct poses ============================================================================================== */

/* Best scores first; of equal ones the earlier. */
static void regi_pose_sort(regi_pose *poses, int count, int kept)
{
    for (int i = 0; i < kept && i < count; i++) {
        int best = i;
        regi_pose found;
        for (int j = i + 1; j < count; j++)
            best = poses[j].score < poses[best].score ? j : best;
        found = poses[best];
        for (int j = best; j > i; j--)
            poses[j] = poses[j - 1];
        poses[i] = found;
    }
}

/* 1 when two poses are 8 degrees or, in the mean over the shape, 5 % of its size apart. */
static int regi_pose_differ(const regi_icp *icp, const regi_pose *p, const regi_pose *q)
{
    const regi_icp_side *model = icp->swapped ? &icp->b : &icp->a;
    reg_rigid first = regi_icp_of_model(icp, &p->motion), second = regi_icp_of_model(icp, &q->motion);
    reg_rigid back = reg_rigid_inverse(&first), between = reg_rigid_compose(&second, &back);
    int probes = sbi_min_int(model->spread.count, REGI_POSE_PROBES);
    sb_real sum = 0;
    if (reg_rigid_angle(&between) > (sb_real)0.14)
        return 1;
    for (int i = 0; i < probes; i++)
        sum += sb_v3_norm(sb_v3_sub(reg_rigid_apply(&first, model->spread.points[i]),
                                    reg_rigid_apply(&second, model->spread.points[i])));
    return sum > (sb_real)0.05 * model->extent * (sb_real)probes;
}

REGI_API int regi_pose_distinct(const regi_icp *icp, regi_pose *poses, int count, int kept)
{
    int found = 0;
    for (int i = 0; i < count && found < kept; i++) {
        int fresh = 1;
        for (int j = 0; j < found && fresh; j++)
            fresh = regi_pose_differ(icp, poses + i, poses + j);
        if (fresh)
            poses[found++] = poses[i];
    }
    return found;
}

/* ==== likelihood ================================================================================================== */

/* Gaps between the shapes for some poses: [poses][room], filled up to count. */
typedef struct regi_pose_gaps {
    sb_real *gap, *weight, *scratch;
    int room, count[REG_ICP_POSES];
} regi_pose_gaps;

/* How far pair n is from the other shape: from the surface, or from the plane through the closest point and, beyond
 * what lies between points, from that. */
static sb_real regi_pose_gap(const regi_icp *icp, const reg_rigid *motion, int n, const regi_icp_side *other)
{
    const regi_icp_pairs *pairs = &icp->pairs;
    sb_vec3 way;
    sb_real plane, beside;
    if (other->surface || !(pairs->weight[n] > 0))
        return pairs->weight[n] > 0 ? pairs->distance[n] : (sb_real)INFINITY;
    way = sb_v3_sub(reg_rigid_apply(motion, pairs->from[n]), pairs->to[n]);
    plane = sb_v3_dot(way, pairs->normal[n]);
    beside = sb_v3_dot(way, way) - plane * plane - other->spacing * other->spacing;
    return sb_sqrt(plane * plane + sb_max(beside, 0));
}

/* Share of neighbouring points' signed gaps that is common to them, in [0, 1]: noise has none, deformation and wrong
 * poses much. gap: of the pose; residual[count]: scratch. */
static sb_real regi_pose_correlation(const regi_icp *icp, const regi_pose *pose, const sb_real *gap, sb_real *residual)
{
    const regi_icp_side *side = &icp->a;
    sb_real products = 0, squares = 0, limit = 3 * pose->noise;
    for (int i = 0; i < side->spread.count; i++) {
        sb_vec3 way = sb_v3_sub(reg_rigid_apply(&pose->motion, icp->pairs.from[i]), icp->pairs.to[i]);
        residual[i] = gap[i] <= limit ? sb_v3_dot(way, icp->pairs.normal[i]) : 0;
    }
    for (int i = 0; i < side->spread.count; i++) {
        int pair[2];
        sb_real squared[2];
        if (reg_kdtree_k_nearest(side->spread_tree, side->spread.points[i], 2, pair, squared) < 2)
            continue;
        squares += residual[i] * residual[i] + residual[pair[1]] * residual[pair[1]];
        products += 2 * residual[i] * residual[pair[1]];
    }
    return squares > 0 ? sb_max(products / squares, 0) : 1;
}

/* The gaps of one pose, and its noise: 1.48 times their median. */
static void regi_pose_look(regi_icp *icp, const regi_icp_stage *last, regi_pose *pose, regi_pose_gaps *gaps, int which)
{
    regi_icp_stage stage = *last;
    sb_real *gap = gaps->gap + (size_t)which * (size_t)gaps->room;
    sb_real *weight = gaps->weight + (size_t)which * (size_t)gaps->room, median;
    int first = icp->a.spread.count;
    stage.spread = 1;
    stage.coarse = 0;
    stage.points = REGI_ICP_FINE;
    stage.outliers = REG_OUTLIERS_NONE;
    stage.reach = SB_REAL_MAX;
    stage.flip = pose->flip;
    regi_icp_pair(icp, &stage, &pose->motion);
    gaps->count[which] = icp->pairs.count;
    for (int i = 0; i < icp->pairs.count; i++) {
        gap[i] = regi_pose_gap(icp, &pose->motion, i, i < first ? &icp->b : &icp->a);
        weight[i] = i < first ? icp->a.spread.weights[i] : icp->b.spread.weights[i - first];
        gaps->scratch[gaps->room + i] = sb_is_finite(gap[i]) ? gap[i] : icp->a.extent + icp->b.extent;
    }
    median =
        reg_outlier_limit(gaps->scratch + gaps->room, icp->pairs.count, REG_OUTLIERS_TRIM, (sb_real)0.5, gaps->scratch);
    pose->noise = (sb_real)1.4826 * sb_max(median, 0);
    pose->lost = 0;
    for (int i = 0; i < icp->pairs.count; i++)
        pose->lost += gap[i] > 6 * pose->noise ? 1 / (sb_real)icp->pairs.count : 0;
    pose->correlation = regi_pose_correlation(icp, pose, gap, gaps->scratch);
}

/* Student's distribution with three degrees of freedom, as log against that of gap 0. */
static sb_real regi_pose_student(sb_real gap, sb_real noise)
{
    sb_real x = gap / noise;
    return -2 * sb_log(1 + x * x / 3);
}

/* Mean log-likelihood of a point for a common noise; what finds no partner counts as a tenth of the size. */
static sb_real regi_pose_mean(const regi_icp *icp, const regi_pose *pose, const regi_pose_gaps *gaps, int which,
                              sb_real noise)
{
    const reg_icp_options *o = icp->options;
    const sb_real *gap = gaps->gap + (size_t)which * (size_t)gaps->room;
    const sb_real *weight = gaps->weight + (size_t)which * (size_t)gaps->room;
    sb_real most = (sb_real)0.1 * (icp->swapped ? icp->b.extent : icp->a.extent), sum = 0, total = 0, share = 1;
    for (int i = 0; i < gaps->count[which]; i++) {
        total += weight[i];
        sum += weight[i] * regi_pose_student(sb_min(gap[i], most), noise);
    }
    sum = total > 0 ? sum / total : 0;
    for (int i = 0; i < o->landmark_count; i++) {
        sb_vec3 way = sb_v3_sub(reg_rigid_apply(&pose->motion, icp->landmarks_a[i]), icp->landmarks_b[i]);
        sum += o->landmarks[i].weight * regi_pose_student(sb_v3_norm(way), noise);
        share += o->landmarks[i].weight;
    }
    return sum / share;
}

/* Patches of a tenth of the model's size in radius, of what looks. */
static sb_real regi_pose_patches(const regi_icp *icp)
{
    const double pi = 3.141592653589793;
    double radius = 0.1 * (double)(icp->swapped ? icp->b.extent : icp->a.extent);
    double patches = radius > 0 ? (double)icp->a.area / (pi * radius * radius) : 1;
    return (sb_real)fmin(fmax(patches, 1), (double)icp->a.spread.count);
}

REGI_API sb_real regi_pose_points(const regi_icp *icp, sb_real correlation)
{
    sb_real n = (sb_real)icp->a.spread.count;
    return n / (1 + correlation * (n / regi_pose_patches(icp) - 1));
}

/* Their likelihoods, by a common noise: the least of all. */
static void regi_pose_weigh(regi_icp *icp, const regi_icp_stage *last, regi_pose *poses, int count,
                            regi_pose_gaps *gaps)
{
    sb_real noise = SB_REAL_MAX, patches = regi_pose_patches(icp), points;
    for (int i = 0; i < count; i++) {
        regi_pose_look(icp, last, poses + i, gaps, i);
        noise = sb_min(noise, poses[i].noise);
    }
    noise = sb_max(noise, 64 * SB_EPSILON * (icp->a.extent + icp->b.extent));
    if (!(noise > 0))
        noise = 1; /* the shapes are points: any unit does */
    for (int i = 0; i < count; i++)
        poses[i].score = -regi_pose_mean(icp, poses + i, gaps, i, noise);
    regi_pose_sort(poses, count, count);
    points = regi_pose_points(icp, poses[0].correlation);
    for (int i = 0; i < count; i++) {
        poses[i].in_front = regi_pose_in_front(icp, &poses[i].motion);
        poses[i].likelihood =
            regi_pose_prior(icp, poses + i, 0) - points * poses[i].score - 10 * patches * poses[i].in_front;
        poses[i].score = -poses[i].likelihood;
    }
    regi_pose_sort(poses, count, count);
}

REGI_API sb_result regi_pose_rank(regi_icp *icp, const regi_icp_stage *last, regi_pose *poses, int count)
{
    regi_pose_gaps gaps;
    size_t room = (size_t)icp->a.spread.count + (size_t)icp->b.spread.count;
    memset(&gaps, 0, sizeof gaps);
    gaps.room = (int)room;
    gaps.gap = (sb_real *)sbi_alloc(icp->allocator, room, (2 * (size_t)count + 2) * sizeof(sb_real));
    if (!gaps.gap)
        return regi_icp_no_memory(icp);
    gaps.weight = gaps.gap + (size_t)count * room;
    gaps.scratch = gaps.weight + (size_t)count * room;
    regi_pose_weigh(icp, last, poses, count, &gaps);
    sbi_free(icp->allocator, gaps.gap);
    return SB_OK;
}

/* ==== search ====================================================================================================== */

/* How the search thins out its candidates. */
typedef struct regi_pose_plan {
    int coarse, points, rounds, kept, distinct;
} regi_pose_plan;

static int regi_pose_stage(regi_icp *icp, const regi_pose_plan *plan, regi_icp_stage *stage, regi_pose *poses,
                           int count, int *begun)
{
    int converged;
    stage->coarse = plan->coarse;
    stage->points = plan->points;
    for (int i = 0; i < count; i++) {
        stage->flip = poses[i].flip;
        regi_icp_iterate(icp, stage, plan->rounds, (sb_real)1e-3, &poses[i].motion, &poses[i].score, &converged);
        if (icp->out_of_time)
            count = i + 1;
    }
    *begun = count;
    regi_pose_sort(poses, count, count);
    count = plan->distinct ? regi_pose_distinct(icp, poses, count, plan->kept) : sbi_min_int(count, plan->kept);
    while (count > 3 && plan->distinct && poses[count - 1].score > 2 * poses[0].score)
        count--; /* far off; some stay to compare with */
    return count;
}

REGI_API sb_result regi_pose_search(regi_icp *icp, const reg_rigid *start, const regi_icp_stage *last, regi_pose *poses,
                                    int *count, int *tried)
{
    static const regi_pose_plan plan[REGI_POSE_STAGES] = {
        {1, 60, 4, 60, 0}, {1, 150, 6, 12, 1}, {1, 300, 8, REG_ICP_POSES, 1}, {0, 300, 5, REG_ICP_POSES, 1}};
    size_t most = 2 * (2 + REGI_POSE_ROTATIONS);
    regi_pose *all = (regi_pose *)sbi_alloc(icp->allocator, most, sizeof(regi_pose));
    regi_icp_stage stage = *last;
    sb_result result;
    int left, begun;
    if (!all)
        return regi_icp_no_memory(icp);
    left = regi_pose_candidates(icp, start, all);
    stage.spread = 1;
    stage.metric = REG_ICP_PLANE;
    stage.outliers = REG_OUTLIERS_TRIM;
    stage.parameter = (sb_real)0.7;
    stage.reach = SB_REAL_MAX;
    stage.lost = (sb_real)0.03 * (icp->swapped ? icp->b.extent : icp->a.extent);
    for (int s = 0; s < REGI_POSE_STAGES; s++) {
        left = regi_pose_stage(icp, plan + s, &stage, all, left, &begun);
        *tried = s == 0 ? begun : *tried;
    }
    result = regi_pose_rank(icp, last, all, left);
    memcpy(poses, all, (size_t)left * sizeof poses[0]);
    *count = left;
    sbi_free(icp->allocator, all);
    return result;
}

/* ==== src/register/icp_report.c ==== */
/* icp_report: how far an alignment can be trusted. */

/* 1.48 times the median distance from the planes of the pairs that count, and what fitting six numbers took off it. */
static sb_real regi_report_noise(regi_icp *icp, const reg_rigid *motion)
{
    regi_icp_pairs *pairs = &icp->pairs;
    sb_real least = 64 * SB_EPSILON * (icp->a.extent + icp->b.extent), limit;
    int count = 0;
    for (int i = 0; i < pairs->count; i++)
        if (pairs->weight[i] > 0) {
            sb_vec3 way = sb_v3_sub(reg_rigid_apply(motion, pairs->from[i]), pairs->to[i]);
            pairs->distance[count++] = sb_abs(sb_v3_dot(way, pairs->normal[i]));
        }
    limit = reg_outlier_limit(pairs->distance, count, REG_OUTLIERS_TRIM, (sb_real)0.5, pairs->scratch);
    limit *= sb_sqrt((sb_real)count / (sb_real)sbi_max_int(count - 6, 1));
    return sb_max((sb_real)1.4826 * limit, least);
}

/* Inverse of the information, about a's moved centre in b's frame. Before anything is seen a turn is known to 1.8 rad
 * (any is as likely), a shift to the shapes' extent, or as well as the start. */
static void regi_report_invert(const regi_icp *icp, const regi_icp_system *seen, sb_real noise,
                               sb_real covariance[6][6])
{
    const reg_icp_options *o = icp->options;
    sb_real size = icp->a.size > 0 ? icp->a.size : 1, turn = (sb_real)1.8, shift = icp->a.extent + icp->b.extent;
    regi_icp_system prior = *seen;
    if (o->start_shift_sd > 0 && o->start_turn_sd > 0) {
        turn = sb_min(turn, o->start_turn_sd);
        shift = sb_min(shift, o->start_shift_sd);
    }
    turn = noise / (size * turn);
    shift = shift > 0 ? noise / shift : 1;
    for (int i = 0; i < 6; i++)
        prior.matrix[i][i] += i < 3 ? turn * turn : shift * shift;
    for (int j = 0; j < 6; j++) {
        regi_icp_system unit = prior;
        memset(unit.right, 0, sizeof unit.right);
        unit.right[j] = 1;
        regi_icp_solve(&unit);
        for (int i = 0; i < 6; i++)
            covariance[i][j] = (i < 3 ? noise / size : noise) * (j < 3 ? noise / size : noise) * unit.right[i];
    }
}

static sb_mat3 regi_report_block(sb_real covariance[6][6], int row, int column)
{
    sb_mat3 block;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            block.m[i][j] = covariance[row + i][column + j];
    return block;
}

/* Of the model's motion, in the target's frame. With the shapes exchanged it is the motion back, by -R^T. */
static void regi_report_covariance(const regi_icp *icp, const reg_rigid *motion, reg_icp_info *info)
{
    regi_icp_system system;
    sb_real covariance[6][6];
    regi_icp_equations(icp, motion, 1, &system);
    regi_report_invert(icp, &system, info->noise, covariance);
    info->centre = icp->swapped ? icp->a.centre : reg_rigid_apply(motion, icp->a.centre);
    for (int row = 0; row < 6; row += 3)
        for (int column = 0; column < 6; column += 3) {
            sb_mat3 block = regi_report_block(covariance, row, column);
            if (icp->swapped)
                block = sb_m3_mul(sb_m3_tmul(motion->rotation, block), motion->rotation);
            for (int i = 0; i < 9; i++)
                info->covariance[(row + i / 3) * 6 + column + i % 3] = block.m[i / 3][i % 3];
        }
}

/* Largest deviation along any direction, of the turn (first 0) or the shift (first 3). */
static sb_real regi_report_largest(const reg_icp_info *info, int first)
{
    sb_mat3 block;
    sb_vec3 values;
    for (int i = 0; i < 9; i++)
        block.m[i / 3][i % 3] = info->covariance[(first + i / 3) * 6 + first + i % 3];
    sb_m3_eigen(block, &values, NULL);
    return sb_sqrt(sb_max(values.x, 0));
}

/* Median distance of the spread points from their centre. */
static sb_real regi_report_radius(regi_icp *icp, const regi_icp_side *side)
{
    regi_icp_pairs *pairs = &icp->pairs;
    for (int i = 0; i < side->spread.count; i++)
        pairs->distance[i] = sb_v3_norm(sb_v3_sub(side->spread.points[i], side->centre));
    return reg_outlier_limit(pairs->distance, side->spread.count, REG_OUTLIERS_TRIM, (sb_real)0.5, pairs->scratch);
}

/* The units that may have been mistaken for each other, or the ratio itself. */
static sb_real regi_report_guess(sb_real ratio)
{
    static const double units[] = {1000, 1e-3, 25.4, 1 / 25.4, 100, 0.01, 10, 0.1, 39.37, 1 / 39.37};
    double best = (double)ratio, least = log(2.5);
    for (int i = 0; i < (int)(sizeof units / sizeof units[0]); i++) {
        double off = fabs(log((double)ratio / units[i]));
        if (off < least) {
            least = off;
            best = units[i];
        }
    }
    return (sb_real)best;
}

/* The shapes' sizes: of the whole organ they agree, a part is no larger than the whole, nor a speck of it. */
static void regi_report_scale(regi_icp *icp, reg_icp_info *info)
{
    sb_real a = regi_report_radius(icp, &icp->a), b = regi_report_radius(icp, &icp->b), ratio, model;
    info->scale_guess = 1;
    if (!(a > 0) || !(b > 0))
        return;
    ratio = a / b; /* a is the part, where there is one, and as a rule three quarters as large */
    model = icp->swapped ? 1 / ratio : ratio;
    if (icp->both ? ratio < (sb_real)1.5 && ratio > 1 / (sb_real)1.5 : ratio < (sb_real)1.5 && ratio > (sb_real)0.05)
        return;
    icp->warnings |= REG_WARN_SCALE;
    if (!icp->both)
        model *= icp->swapped ? (sb_real)0.75 : 1 / (sb_real)0.75;
    info->scale_guess = regi_report_guess(model);
}

REGI_API sb_result regi_icp_report(regi_icp *icp, const regi_icp_stage *stage, const regi_pose *best,
                                   reg_icp_info *info)
{
    const regi_icp_side *model = icp->swapped ? &icp->b : &icp->a, *target = icp->swapped ? &icp->a : &icp->b;
    regi_pose pose = *best;
    sb_real dependent, model_size = sb_max(model->extent, target->extent);
    sb_result result;
    info->noise = regi_report_noise(icp, &pose.motion);
    regi_report_covariance(icp, &pose.motion, info);
    result = regi_pose_rank(icp, stage, &pose, 1);
    if (result != SB_OK)
        return result;
    dependent = sb_sqrt(sb_max(1, (sb_real)info->pairs / regi_pose_points(icp, pose.correlation)));
    if (dependent * regi_report_largest(info, 0) > (sb_real)0.087 ||
        dependent * regi_report_largest(info, 3) > (sb_real)0.02 * model_size)
        icp->warnings |= REG_WARN_LOW_CONTRAST;
    info->seen = model->area > 0 ? sb_min(target->area / model->area, 1) : 1;
    if (icp->swapped && info->seen < (sb_real)0.15)
        icp->warnings |= REG_WARN_VIEW_SMALL;
    if (pose.lost > (sb_real)0.3)
        icp->warnings |= REG_WARN_MANY_OUTLIERS;
    if (pose.in_front > (sb_real)0.1)
        icp->warnings |= REG_WARN_FREE_SPACE;
    regi_report_scale(icp, info);
    return SB_OK;
}

/* ==== src/register/icp.c ==== */
/* icp: the call: what it accepts, its last stage, and what it reports. */

enum { REGI_ICP_COOKIE = 0x72696370 };

REG_API reg_icp_options reg_default_icp_options(void)
{
    reg_icp_options options;
    memset(&options, 0, sizeof options);
    options.metric = REG_ICP_PLANE;
    options.search = 1;
    options.start = reg_rigid_identity();
    options.outliers = REG_OUTLIERS_MEDIAN;
    options.outlier_parameter = 3;
    options.max_distance = SB_REAL_MAX;
    options.sample = 2000;
    options.max_iterations = 100;
    options.tolerance = (sb_real)1e-6;
    options.max_seconds = 10;
    options.cookie = REGI_ICP_COOKIE;
    return options;
}

REG_API const char *reg_icp_stop_string(reg_icp_stop stop)
{
    switch (stop) {
    case REG_ICP_CONVERGED: return "converged";
    case REG_ICP_ITERATIONS: return "iterations";
    case REG_ICP_TIME: return "time";
    }
    return "unknown";
}

REG_API const char *reg_warning_string(reg_warning warning)
{
    switch (warning) {
    case REG_WARN_AMBIGUOUS: return "ambiguous";
    case REG_WARN_INVERTED: return "inverted normals";
    case REG_WARN_MIXED_NORMALS: return "mixed normals";
    case REG_WARN_SCALE: return "scale";
    case REG_WARN_VIEW_SMALL: return "small view";
    case REG_WARN_MANY_OUTLIERS: return "many outliers";
    case REG_WARN_LOW_CONTRAST: return "low contrast";
    case REG_WARN_FREE_SPACE: return "free space";
    case REG_WARN_STRAIN: return "strain";
    case REG_WARN_VOLUME: return "volume";
    case REG_WARN_NOT_AT_REST: return "not at rest";
    }
    return "unknown";
}

/* ==== checks ====================================================================================================== */

static sb_result regi_icp_check(const reg_icp_shape *shape, const char *which, sb_error *error)
{
    sb_result result = regi_cloud_check(shape->points, shape->normals, shape->count, error);
    sb_real most = 0;
    if (result != SB_OK)
        return result;
    for (int i = 0; shape->weights && i < shape->count; i++) {
        if (!(shape->weights[i] >= 0) || !sb_is_finite(shape->weights[i]))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "the weight of the %s's point %d is %g", which, i,
                                 (double)shape->weights[i]);
        most = sb_max(most, shape->weights[i]);
    }
    if (shape->weights && !(most > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "all weights of the %s are 0", which);
    for (int i = 0; shape->sd && i < shape->count; i++)
        if (!(shape->sd[i] > 0) || !sb_is_finite(shape->sd[i]))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "the sd of the %s's point %d is %g", which, i,
                                 (double)shape->sd[i]);
    if (!sb_v3_is_finite(shape->camera))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the camera of the %s is not finite", which);
    if (shape->tree && reg_kdtree_count(shape->tree) != shape->count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the %s has %d points, its tree %d", which, shape->count,
                        reg_kdtree_count(shape->tree));
    return SB_OK;
}

static sb_result regi_icp_check_landmarks(const reg_icp_options *o, sb_error *error)
{
    if (o->landmark_count < 0 || (o->landmark_count > 0 && !o->landmarks))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d landmarks without an array", o->landmark_count);
    for (int i = 0; i < o->landmark_count; i++) {
        const reg_icp_landmark *l = o->landmarks + i;
        if (!sb_v3_is_finite(l->model) || !sb_v3_is_finite(l->target))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "landmark %d is not finite", i);
        if (!(l->weight > 0) || !sb_is_finite(l->weight))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "the weight of landmark %d is %g", i, (double)l->weight);
    }
    return SB_OK;
}

static sb_result regi_icp_check_options(const reg_icp_options *o, sb_error *error)
{
    sb_real one = 1, scratch;
    if (o->cookie != REGI_ICP_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the options do not come from reg_default_icp_options()");
    if ((int)o->overlap < REG_ICP_WHOLE || (int)o->overlap > REG_ICP_MODEL_PART)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d is no kind of overlap", (int)o->overlap);
    if ((int)o->metric < REG_ICP_POINT || (int)o->metric > REG_ICP_PLANE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d is no metric", (int)o->metric);
    if (!(o->max_distance > 0) || o->sample < 0 || o->max_iterations < 1 || !(o->tolerance >= 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_distance, sample, max_iterations or tolerance is out of range");
    if (o->clock && !(o->max_seconds > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_seconds is %g, it must be positive", o->max_seconds);
    if (!sb_v3_is_finite(o->start.translation) || !sb_is_finite(sbi_dense_max_abs(&o->start.rotation.m[0][0], 9)))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the start is not finite");
    if (!(o->start_shift_sd >= 0) || !(o->start_turn_sd >= 0) || !(o->seen_from_sd >= 0) ||
        !sb_is_finite(o->start_shift_sd + o->start_turn_sd + o->seen_from_sd))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a deviation of the start or of seen_from is out of range");
    if (!sb_v3_is_finite(o->seen_from))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "seen_from is not finite");
    if (o->seen_from_sd > 0 && !(sb_v3_norm(o->seen_from) > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "seen_from is 0, but seen_from_sd is not");
    if (reg_outlier_limit(&one, 1, o->outliers, o->outlier_parameter, &scratch) < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "outlier rule %d with the parameter %g is out of range",
                        (int)o->outliers, (double)o->outlier_parameter);
    return regi_icp_check_landmarks(o, error);
}

static sb_result regi_icp_make_pairs(regi_icp *icp)
{
    int landmarks = icp->options->landmark_count;
    int points = sbi_max_int(icp->a.sample.count, icp->a.spread.count);
    int others = sbi_max_int(icp->b.sample.count, icp->b.spread.count);
    int most = icp->both ? points + others : sbi_max_int(points, others);
    size_t room = (size_t)most + (size_t)landmarks;
    regi_icp_pairs *p = &icp->pairs;
    p->from = (sb_vec3 *)sbi_alloc(icp->allocator, room, 3 * sizeof(sb_vec3));
    p->weight = (sb_real *)sbi_alloc(icp->allocator, room, 3 * sizeof(sb_real));
    icp->landmarks_a = (sb_vec3 *)sbi_alloc(icp->allocator, (size_t)landmarks, 2 * sizeof(sb_vec3));
    if (!p->from || !p->weight || !icp->landmarks_a)
        return regi_icp_no_memory(icp);
    p->to = p->from + room;
    p->normal = p->to + room;
    p->distance = p->weight + room;
    p->scratch = p->distance + room;
    icp->landmarks_b = icp->landmarks_a + landmarks;
    for (int i = 0; i < landmarks; i++) {
        const reg_icp_landmark *l = icp->options->landmarks + i;
        icp->landmarks_a[i] = icp->swapped ? l->target : l->model;
        icp->landmarks_b[i] = icp->swapped ? l->model : l->target;
    }
    return SB_OK;
}

/* ==== the call ==================================================================================================== */

static void regi_icp_tell(regi_icp *icp, const reg_rigid *motion, reg_icp_info *info)
{
    sb_real total = 0, squares = 0;
    for (int i = 0; i < icp->options->landmark_count; i++) {
        sb_vec3 gap = sb_v3_sub(reg_rigid_apply(motion, icp->landmarks_a[i]), icp->landmarks_b[i]);
        squares += icp->options->landmarks[i].weight * sb_v3_dot(gap, gap);
        total += icp->options->landmarks[i].weight;
    }
    info->pairs = regi_icp_measure(&icp->pairs, &info->mean, &info->rms);
    info->overlap = (sb_real)info->pairs / (sb_real)sbi_max_int(icp->pairs.count, 1);
    info->landmark_rms = total > 0 ? sb_sqrt(squares / total) : 0;
    info->seconds = icp->options->clock ? icp->options->clock() - icp->begun : 0;
}

/* Which way fitted normals point is not known (an outlier on top turns them all): the way that lets more pairs be. */
static int regi_icp_find_flip(regi_icp *icp, const regi_icp_stage *last, const reg_rigid *motion)
{
    regi_icp_stage stage = *last;
    sb_real as_they_are;
    stage.lost = (sb_real)0.25 * icp->a.size;
    as_they_are = regi_icp_pair(icp, &stage, motion);
    stage.flip = -1;
    return regi_icp_pair(icp, &stage, motion) < as_they_are ? -1 : 1;
}

/* The poses to begin the last stage with, the likeliest first. */
static sb_result regi_icp_begin(regi_icp *icp, const reg_rigid *start, const regi_icp_stage *stage, regi_pose *poses,
                                reg_icp_info *info)
{
    if (icp->options->search)
        return regi_pose_search(icp, start, stage, poses, &info->pose_count, &info->candidates);
    memset(poses, 0, sizeof poses[0]);
    poses[0].motion = *start;
    poses[0].flip = icp->a.unsure || icp->b.unsure ? regi_icp_find_flip(icp, stage, start) : 1;
    info->pose_count = 1;
    return SB_OK;
}

/* Whether so many nats tell two poses apart. */
static int regi_icp_is_clear(sb_real nats) { return nats >= 3; }

/* The poses and how clearly they are told apart; motions of the model from here on. */
static void regi_icp_tell_poses(regi_icp *icp, const regi_pose *poses, reg_icp_info *info)
{
    for (int i = 0; i < info->pose_count; i++) {
        info->poses[i] = regi_icp_of_model(icp, &poses[i].motion);
        info->likelihood[i] = poses[i].likelihood - poses[0].likelihood;
    }
    info->margin = info->pose_count > 1 ? -info->likelihood[1] : SB_REAL_MAX;
    if (!regi_icp_is_clear(info->margin))
        icp->warnings |= REG_WARN_AMBIGUOUS;
    if (poses[0].flip < 0 && !icp->a.fitted && !icp->b.fitted)
        icp->warnings |= REG_WARN_INVERTED;
}

/* The last stage for the poses that may be the right one as well as the first. */
static void regi_icp_refine_others(regi_icp *icp, const regi_icp_stage *last, regi_pose *poses, int count)
{
    regi_icp_stage stage = *last;
    sb_real score;
    int converged;
    for (int i = 1; i < count; i++) {
        stage.flip = poses[i].flip;
        if (!regi_icp_is_clear(poses[0].likelihood - poses[i].likelihood))
            regi_icp_iterate(icp, &stage, icp->options->max_iterations, icp->options->tolerance, &poses[i].motion,
                             &score, &converged);
    }
}

static sb_result regi_icp_run(regi_icp *icp, const reg_rigid *start, reg_icp_info *info)
{
    const reg_icp_options *options = icp->options;
    regi_pose poses[REG_ICP_POSES];
    regi_icp_stage stage;
    sb_result result;
    sb_real score;
    int converged;
    memset(&stage, 0, sizeof stage);
    stage.points = sbi_max_int(icp->a.sample.count, icp->b.sample.count);
    stage.metric = options->metric;
    stage.outliers = options->outliers;
    stage.parameter = options->outlier_parameter;
    stage.reach = options->max_distance;
    stage.flip = 1;
    result = regi_icp_begin(icp, start, &stage, poses, info);
    if (result != SB_OK)
        return result;
    regi_icp_refine_others(icp, &stage, poses, info->pose_count);
    stage.flip = poses[0].flip;
    info->iterations = regi_icp_iterate(icp, &stage, options->max_iterations, options->tolerance, &poses[0].motion,
                                        &score, &converged);
    info->stop = converged ? REG_ICP_CONVERGED : icp->out_of_time ? REG_ICP_TIME : REG_ICP_ITERATIONS;
    regi_icp_tell(icp, &poses[0].motion, info);
    if (info->pairs == 0)
        return sbi_fail(icp->error, SB_ERROR_NOT_CONVERGED, "no points of the shapes are within %g m of each other",
                        (double)options->max_distance);
    info->pose_count = regi_pose_distinct(icp, poses, info->pose_count, REG_ICP_POSES); /* the last stage moved one */
    regi_icp_tell_poses(icp, poses, info);
    result = regi_icp_report(icp, &stage, &poses[0], info);
    info->warnings = icp->warnings;
    return result;
}

REG_API sb_result reg_icp(const reg_icp_shape *model, const reg_icp_shape *target, const reg_icp_options *options,
                          reg_rigid *motion, reg_icp_info *info, sb_error *error)
{
    reg_icp_options defaults = reg_default_icp_options();
    reg_icp_info report;
    reg_rigid start;
    regi_icp icp;
    sb_result result;
    if (!model || !target || !motion)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "model, target or motion is NULL");
    memset(&icp, 0, sizeof icp);
    memset(&report, 0, sizeof report);
    icp.options = options ? options : &defaults;
    icp.allocator = &icp.options->allocator;
    icp.error = error;
    result = regi_icp_check_options(icp.options, error);
    if (result == SB_OK)
        result = regi_icp_check(model, "model", error);
    if (result == SB_OK)
        result = regi_icp_check(target, "target", error);
    if (result != SB_OK)
        return result;
    icp.begun = icp.options->clock ? icp.options->clock() : 0;
    icp.target = target;
    icp.both = icp.options->overlap == REG_ICP_WHOLE;
    icp.swapped = icp.options->overlap == REG_ICP_TARGET_PART;
    result = regi_icp_side_make(&icp, icp.swapped ? target : model, &icp.a);
    if (result == SB_OK)
        result = regi_icp_side_make(&icp, icp.swapped ? model : target, &icp.b);
    if (result == SB_OK)
        result = regi_icp_make_pairs(&icp);
    start = icp.swapped ? reg_rigid_inverse(&icp.options->start) : icp.options->start;
    if (result == SB_OK)
        result = regi_icp_run(&icp, &start, &report);
    if (result == SB_OK) {
        *motion = report.poses[0];
        if (info)
            *info = report;
    }
    sbi_free(icp.allocator, icp.pairs.from);
    sbi_free(icp.allocator, icp.pairs.weight);
    sbi_free(icp.allocator, icp.landmarks_a);
    regi_icp_side_free(icp.allocator, &icp.a);
    regi_icp_side_free(icp.allocator, &icp.b);
    return result;
}

/* ==== src/register/cpd_private.h ==== */
/* cpd_private: what coherent point drift shares among its parts. Internal: cpd_sums.c finds expected partners,
 * cpd_kernel.c factors the kernel and solves for the deformation, cpd.c iterates. All in the frames of the clouds. */
#ifndef REGI_CPD_STATE_H
#define REGI_CPD_STATE_H


enum {
    REGI_CPD_LANES = 16, /* points of a block: a loop of fixed length, which compilers vectorise at -O2 */
    REGI_CPD_CHUNKS = 8  /* parts of the target with sums of their own: tasks, whatever the number of threads */
};

/* Coordinates of a block of points. The last block is filled up with its last point. */
typedef struct regi_cpd_block {
    double x[REGI_CPD_LANES], y[REGI_CPD_LANES], z[REGI_CPD_LANES];
} regi_cpd_block;

typedef struct regi_cpd_box {
    double low[3], high[3];
} regi_cpd_box;

/* A cloud in an order that keeps neighbours together. */
typedef struct regi_cpd_cloud {
    int count, blocks;
    int *order;             /* [count] the caller's index of each point */
    regi_cpd_block *points; /* [blocks] */
    regi_cpd_box *boxes;    /* [blocks] */
} regi_cpd_cloud;

/* What a block of source points gathers: sum_n P_mn, and sum_n P_mn (x_n - T y_m), which keeps digits that the sum of
 * P x loses once sigma is small. */
typedef struct regi_cpd_sums {
    double p[REGI_CPD_LANES], x[REGI_CPD_LANES], y[REGI_CPD_LANES], z[REGI_CPD_LANES];
} regi_cpd_sums;

typedef struct regi_cpd_totals {
    double explained; /* sum P */
    double squares;   /* sum P |x_n - T y_m|^2 */
    double logs;      /* sum_n -log(sum_m exp(-|x_n - T y_m|^2 / 2 s2) + c) */
    double pairs;
} regi_cpd_totals;

/* Most probable partner of each source point. */
typedef struct regi_cpd_best {
    double probability[REGI_CPD_LANES];
    int target[REGI_CPD_LANES]; /* the caller's index, or -1 */
} regi_cpd_best;

/* One evaluation of all P_mn. */
typedef struct regi_cpd_expectation {
    const regi_cpd_cloud *target;
    const regi_cpd_cloud *source;            /* boxes: of the moved points */
    const regi_cpd_block *moved;             /* [source blocks] */
    double sigma2, outlier;                  /* outlier: c, in the sum beside the Gaussians */
    double tolerance;                        /* share of each target point that may be left out */
    regi_cpd_sums *sums;                     /* [CHUNKS][source blocks]; the first row becomes the result */
    regi_cpd_totals totals[REGI_CPD_CHUNKS]; /* likewise */
    double (*terms)[REGI_CPD_LANES];         /* [CHUNKS][source blocks] */
    int *near_blocks;                        /* [CHUNKS][source blocks] */
    regi_cpd_best *best;                     /* [source blocks], or NULL: not wanted */
} regi_cpd_expectation;

/* The factor of the kernel, G = L L^T to the tolerance, by columns. */
typedef struct regi_cpd_kernel {
    sb_allocator allocator;
    int rank, capacity;
    size_t rows;      /* source points, filled up to whole blocks; those rows are 0 */
    double inverse;   /* 1 / (2 beta^2) */
    double *columns;  /* [capacity][rows] */
    int *pivots;      /* [capacity] rows */
    double *diagonal; /* [rows] what is left of the diagonal; -1: a pivot */
    double *system;   /* [rank][stride] L^T P L + lambda s2, then its Cholesky factor, lower half */
    double *scaled;   /* [rank][REGI_CPD_SLICE] */
    size_t stride;
    double *weights[3]; /* [stride] c: T = Y + L c */
} regi_cpd_kernel;

#if defined(REG_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* Fills sums, totals[0] and best. Allocates nothing. */
REGI_API void regi_cpd_expect(regi_cpd_expectation *e, const sb_jobs *jobs);
REGI_API void regi_cpd_bound(const regi_cpd_block *points, int blocks, regi_cpd_box *boxes);

/* Factors the kernel of `points`, until the largest remaining diagonal entry is within tolerance or at max_rank
 * columns. On failure (SB_ERROR_MEMORY) free it, too. */
REGI_API sb_result regi_cpd_kernel_create(const regi_cpd_cloud *source, double beta, double tolerance, int max_rank,
                                          const sb_allocator *allocator, regi_cpd_kernel *kernel, sb_error *error);
REGI_API void regi_cpd_kernel_free(regi_cpd_kernel *kernel);
/* weights = (L^T P L + ridge)^-1 L^T r; p[rows], r[3][rows] in the order of the source. Returns |weights|^2. */
REGI_API double regi_cpd_kernel_solve(regi_cpd_kernel *kernel, const double *p, double *const r[3], double ridge,
                                      const sb_jobs *jobs);
/* a = l l^T in place, lower half, by strips of columns; a is known to be at least `ridge` above singular. */
REGI_API void regi_cpd_factor(double *a, int n, size_t stride, double ridge);
/* b becomes (l l^T)^-1 b. */
REGI_API void regi_cpd_back_solve(const double *l, int n, size_t stride, double *b);
/* moved = points + L weights. */
REGI_API void regi_cpd_kernel_move(const regi_cpd_kernel *kernel, const regi_cpd_block *points, regi_cpd_block *moved);
/* weights become those of the Gaussians at the pivots. */
REGI_API void regi_cpd_kernel_spread(regi_cpd_kernel *kernel);
#endif

#endif /* REGI_CPD_STATE_H */

/* ==== src/register/cpd_sums.c ==== */
/* cpd_sums: the expectation step, P_mn = exp(-|x_n - T y_m|^2 / 2 s2) / (sum_k exp(-|x_n - T y_k|^2 / 2 s2) + c).
 *
 * Both clouds lie in blocks of neighbours. For a block of the target, blocks of the source are left out whose share of
 * every P is small for certain, by the distances of boxes; all others are summed in loops over whole blocks. That is
 * faster than a search tree with its single points, needs none for the source, which moves, and the bound holds without
 * a guess of the width: a term left out is below tolerance / M of the largest term, or of c. */

#include <string.h>

/* e^x for x <= 0 to 1e-11 of it (below -700: e^-700), of operations that vectorise: 2^n 2^f with n in the low bits of
 * a sum with 1.5 2^52. */
SBI_FORCE_INLINE double regi_cpd_exp(double x)
{
    double t = (x > -700.0 ? x : -700.0) * 1.4426950408889634, n = t + 6755399441055744.0;
    double f = t - (n - 6755399441055744.0), p;
    p = 1.3215486790144307e-6 + f * 1.0178086009239699e-7;
    p = 1.5403530393381608e-4 + f * (1.5252733804059841e-5 + f * p);
    p = 9.618129107628477e-3 + f * (1.3333558146428443e-3 + f * p);
    p = 2.402265069591007e-1 + f * (5.550410866482158e-2 + f * p);
    p = 1.0 + f * (6.931471805599453e-1 + f * p);
    return sbi_dense_from_bits(sbi_dense_bits(p) + (sbi_dense_bits(n) << 52));
}

REGI_API void regi_cpd_bound(const regi_cpd_block *points, int blocks, regi_cpd_box *boxes)
{
    for (int b = 0; b < blocks; b++)
        for (int axis = 0; axis < 3; axis++) {
            const double *x = axis == 0 ? points[b].x : axis == 1 ? points[b].y : points[b].z;
            double low = x[0], high = x[0];
            for (int l = 1; l < REGI_CPD_LANES; l++) {
                low = x[l] < low ? x[l] : low;
                high = x[l] > high ? x[l] : high;
            }
            boxes[b].low[axis] = low;
            boxes[b].high[axis] = high;
        }
}

/* Squares of the smallest and the largest distance between points of two boxes. */
static void regi_cpd_box_distances(const regi_cpd_box *a, const regi_cpd_box *b, double *least, double *most)
{
    double near_sum = 0, far_sum = 0;
    for (int axis = 0; axis < 3; axis++) {
        double up = b->high[axis] - a->low[axis], down = a->high[axis] - b->low[axis];
        double gap = -up > -down ? -up : -down, reach = up > down ? up : down;
        near_sum += gap > 0 ? gap * gap : 0.0;
        far_sum += reach * reach;
    }
    *least = near_sum;
    *most = far_sum;
}

/* Blocks of the source that count for a block of the target; returns how many. */
static int regi_cpd_find_near(const regi_cpd_expectation *e, const regi_cpd_box *box, int *blocks)
{
    double width = 2 * e->sigma2, limit = 1.7976931348623157e308, least, most;
    double share = e->tolerance > 0 ? sbi_dense_log((double)e->source->count / e->tolerance) : 0.0;
    int count = 0;
    if (e->tolerance > 0) {
        for (int b = 0; b < e->source->blocks; b++) {
            regi_cpd_box_distances(box, e->source->boxes + b, &least, &most);
            limit = most < limit ? most : limit;
        }
        limit += width * share;
        if (e->outlier > 0 && e->outlier < 1) { /* a point that is near has most of its probability */
            double alone = width * (share - sbi_dense_log(e->outlier));
            limit = alone < limit ? alone : limit;
        }
    }
    for (int b = 0; b < e->source->blocks; b++) {
        regi_cpd_box_distances(box, e->source->boxes + b, &least, &most);
        if (least <= limit)
            blocks[count++] = b;
    }
    return count;
}

/* terms = squared distances; returns the smallest. */
static double regi_cpd_distances(const regi_cpd_block *moved, const int *blocks, int count, const double at[3],
                                 double (*SB_RESTRICT terms)[REGI_CPD_LANES])
{
    double low[REGI_CPD_LANES], least;
    for (int l = 0; l < REGI_CPD_LANES; l++)
        low[l] = 1.7976931348623157e308;
    for (int i = 0; i < count; i++) {
        const regi_cpd_block *block = moved + blocks[i];
        double *SB_RESTRICT out = terms[i];
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            double x = at[0] - block->x[l], y = at[1] - block->y[l], z = at[2] - block->z[l], d = x * x + y * y + z * z;
            out[l] = d;
            low[l] = d < low[l] ? d : low[l];
        }
    }
    least = low[0];
    for (int l = 1; l < REGI_CPD_LANES; l++)
        least = low[l] < least ? low[l] : least;
    return least;
}

/* terms = exp((least - terms) / 2 s2), 0 for what fills up the last block; returns their sum. */
static double regi_cpd_exponentials(const regi_cpd_expectation *e, double least, const int *blocks, int count,
                                    double (*SB_RESTRICT terms)[REGI_CPD_LANES])
{
    double sums[REGI_CPD_LANES], sum = 0, scale = 1 / (2 * e->sigma2);
    int used = e->source->count - (e->source->blocks - 1) * REGI_CPD_LANES;
    for (int l = 0; l < REGI_CPD_LANES; l++)
        sums[l] = 0;
    for (int i = 0; i < count; i++) {
        double *SB_RESTRICT out = terms[i];
        for (int l = 0; l < REGI_CPD_LANES; l++)
            out[l] = regi_cpd_exp((least - out[l]) * scale);
        if (blocks[i] == e->source->blocks - 1)
            for (int l = used; l < REGI_CPD_LANES; l++)
                out[l] = 0;
        for (int l = 0; l < REGI_CPD_LANES; l++)
            sums[l] += out[l];
    }
    for (int l = 0; l < REGI_CPD_LANES; l++)
        sum += sums[l];
    return sum;
}

/* Adds P of one target point, factor terms, to the sums; returns sum P |x - T|^2. */
static double regi_cpd_gather(const regi_cpd_block *moved, const int *blocks, int count, const double at[3],
                              double factor, double (*SB_RESTRICT terms)[REGI_CPD_LANES],
                              regi_cpd_sums *SB_RESTRICT sums)
{
    double squares[REGI_CPD_LANES], sum = 0;
    for (int l = 0; l < REGI_CPD_LANES; l++)
        squares[l] = 0;
    for (int i = 0; i < count; i++) {
        const regi_cpd_block *block = moved + blocks[i];
        regi_cpd_sums *SB_RESTRICT out = sums + blocks[i];
        const double *SB_RESTRICT term = terms[i];
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            double p = factor * term[l], x = at[0] - block->x[l], y = at[1] - block->y[l], z = at[2] - block->z[l];
            out->p[l] += p;
            out->x[l] += p * x;
            out->y[l] += p * y;
            out->z[l] += p * z;
            squares[l] += p * (x * x + y * y + z * z);
        }
    }
    for (int l = 0; l < REGI_CPD_LANES; l++)
        sum += squares[l];
    return sum;
}

static void regi_cpd_compare(const int *blocks, int count, int target, double factor,
                             double (*SB_RESTRICT terms)[REGI_CPD_LANES], regi_cpd_best *best)
{
    for (int i = 0; i < count; i++) {
        regi_cpd_best *b = best + blocks[i];
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            double p = factor * terms[i][l];
            if (p > b->probability[l] || (p > 0 && p == b->probability[l] && target < b->target[l])) {
                b->probability[l] = p;
                b->target[l] = target;
            }
        }
    }
}

/* One target point. The largest term is made 1, so that a point far from all still has partners when c is 0. */
static void regi_cpd_take(regi_cpd_expectation *e, int chunk, int index, int count)
{
    const regi_cpd_block *block = e->target->points + index / REGI_CPD_LANES;
    int lane = index % REGI_CPD_LANES;
    size_t first = (size_t)chunk * (size_t)e->source->blocks;
    const int *blocks = e->near_blocks + first;
    double(*terms)[REGI_CPD_LANES] = e->terms + first;
    double at[3], least, sum, depth, factor;
    regi_cpd_totals *totals = e->totals + chunk;
    at[0] = block->x[lane], at[1] = block->y[lane], at[2] = block->z[lane];
    least = regi_cpd_distances(e->moved, blocks, count, at, terms);
    if (e->outlier > 0 &&
        (count == 0 || least > 700 * 2 * e->sigma2)) { /* below anything that differs from 0 beside c */
        totals->logs -= sbi_dense_log(e->outlier);
        return;
    }
    depth = least / (2 * e->sigma2);
    sum = regi_cpd_exponentials(e, least, blocks, count, terms);
    if (e->outlier > 0) {
        double size = sbi_dense_exp(-depth), whole = size * sum + e->outlier;
        factor = size / whole;
        totals->logs -= sbi_dense_log(whole);
    } else {
        factor = 1 / sum;
        totals->logs += depth - sbi_dense_log(sum);
    }
    totals->explained += factor * sum;
    totals->pairs += (double)(count * REGI_CPD_LANES);
    totals->squares += regi_cpd_gather(e->moved, blocks, count, at, factor, terms, e->sums + first);
    if (e->best)
        regi_cpd_compare(blocks, count, e->target->order[index], factor, terms, e->best);
}

static void regi_cpd_expect_chunk(void *user, int chunk)
{
    regi_cpd_expectation *e = (regi_cpd_expectation *)user;
    size_t first = (size_t)chunk * (size_t)e->source->blocks;
    int chunks = e->best ? 1 : REGI_CPD_CHUNKS; /* partners are kept once */
    int begin = (int)((int64_t)e->target->blocks * chunk / chunks);
    int end = (int)((int64_t)e->target->blocks * (chunk + 1) / chunks);
    memset(e->sums + first, 0, (size_t)e->source->blocks * sizeof(regi_cpd_sums));
    memset(e->totals + chunk, 0, sizeof(regi_cpd_totals));
    if (chunk >= chunks)
        return;
    for (int b = begin; b < end; b++) {
        int count = regi_cpd_find_near(e, e->target->boxes + b, e->near_blocks + first);
        int last = sbi_min_int((b + 1) * REGI_CPD_LANES, e->target->count);
        for (int i = b * REGI_CPD_LANES; i < last; i++)
            regi_cpd_take(e, chunk, i, count);
    }
}

REGI_API void regi_cpd_expect(regi_cpd_expectation *e, const sb_jobs *jobs)
{
    int blocks = e->source->blocks;
    for (int b = 0; e->best && b < blocks; b++)
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            e->best[b].probability[l] = 0;
            e->best[b].target[l] = -1;
        }
    sbi_run(jobs, regi_cpd_expect_chunk, e, REGI_CPD_CHUNKS);
    for (int chunk = 1; chunk < REGI_CPD_CHUNKS; chunk++) {
        const regi_cpd_sums *from = e->sums + (size_t)chunk * (size_t)blocks;
        e->totals[0].explained += e->totals[chunk].explained;
        e->totals[0].squares += e->totals[chunk].squares;
        e->totals[0].logs += e->totals[chunk].logs;
        e->totals[0].pairs += e->totals[chunk].pairs;
        for (int b = 0; b < blocks; b++)
            for (int l = 0; l < REGI_CPD_LANES; l++) {
                e->sums[b].p[l] += from[b].p[l];
                e->sums[b].x[l] += from[b].x[l];
                e->sums[b].y[l] += from[b].y[l];
                e->sums[b].z[l] += from[b].z[l];
            }
    }
}

/* ==== src/register/cpd_kernel.c ==== */
/* cpd_kernel: the factor of the Gaussian kernel, and the system for the deformation.
 *
 * With G = L L^T the system of the paper, (P G + lambda s2) W = r with r = P X - P Y, is met by T = Y + L c with
 * (L^T P L + lambda s2) c = L^T r: symmetric and positive definite, and points without partners (P = 0) need no
 * division. c = L^T W, so |c|^2 is the regularising term tr(W^T G W). */

#include <string.h>

enum {
    REGI_CPD_FIRST = 64,  /* columns that are made room for at first */
    REGI_CPD_SLICE = 512, /* rows of L that are weighted at a time: all columns of a slice stay in the cache */
    REGI_CPD_STRIP = 32,  /* rows of the system per task, and per step of its factorisation */
    REGI_CPD_FOUR = 4     /* lanes of a sum of products */
};

static double regi_cpd_gauss(const double a[3], double x, double y, double z, double inverse)
{
    double dx = a[0] - x, dy = a[1] - y, dz = a[2] - z;
    return sbi_dense_exp(-(dx * dx + dy * dy + dz * dz) * inverse);
}

static double regi_cpd_not_below_0(double x) { return x > 0 ? x : 0.0; }

/* sum a_i b_i; count is a multiple of REGI_CPD_FOUR. */
static double regi_cpd_dot(const double *a, const double *b, size_t count)
{
    double sum[REGI_CPD_FOUR] = {0, 0, 0, 0};
    for (size_t i = 0; i < count; i += REGI_CPD_FOUR)
        for (int l = 0; l < REGI_CPD_FOUR; l++)
            sum[l] += a[i + (size_t)l] * b[i + (size_t)l];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* out += s a over whole blocks. */
static void regi_cpd_add(double *SB_RESTRICT out, double s, const double *SB_RESTRICT a, size_t count)
{
    for (size_t i = 0; i < count; i += REGI_CPD_LANES)
        for (int l = 0; l < REGI_CPD_LANES; l++)
            out[i + (size_t)l] += s * a[i + (size_t)l];
}

/* ---- factor ---- */

REGI_API void regi_cpd_kernel_free(regi_cpd_kernel *kernel)
{
    sbi_free(&kernel->allocator, kernel->columns);
    sbi_free(&kernel->allocator, kernel->pivots);
    sbi_free(&kernel->allocator, kernel->diagonal);
    sbi_free(&kernel->allocator, kernel->system);
    sbi_free(&kernel->allocator, kernel->scaled);
    sbi_free(&kernel->allocator, kernel->weights[0]);
}

static int regi_cpd_grow(regi_cpd_kernel *kernel, int capacity)
{
    size_t old = (size_t)kernel->rank * kernel->rows;
    double *columns = kernel->rows <= SIZE_MAX / sizeof(double)
                          ? (double *)sbi_alloc(&kernel->allocator, (size_t)capacity, kernel->rows * sizeof(double))
                          : NULL;
    int *pivots = (int *)sbi_alloc(&kernel->allocator, (size_t)capacity, sizeof(int));
    if (!columns || !pivots) {
        sbi_free(&kernel->allocator, columns);
        sbi_free(&kernel->allocator, pivots);
        return 0;
    }
    if (old > 0) {
        memcpy(columns, kernel->columns, old * sizeof(double));
        memcpy(pivots, kernel->pivots, (size_t)kernel->rank * sizeof(int));
    }
    sbi_free(&kernel->allocator, kernel->columns);
    sbi_free(&kernel->allocator, kernel->pivots);
    kernel->columns = columns;
    kernel->pivots = pivots;
    kernel->capacity = capacity;
    return 1;
}

/* The row with the largest remaining diagonal entry above tolerance, of equal ones the first; -1: none. */
static int regi_cpd_next_pivot(const regi_cpd_kernel *kernel, int count, double tolerance)
{
    double most = tolerance;
    int pivot = -1;
    for (int i = 0; i < count; i++)
        if (kernel->diagonal[i] > most) {
            most = kernel->diagonal[i];
            pivot = i;
        }
    return pivot;
}

/* Column `rank` of the factor: what the columns before leave of the pivot's column of G. */
static void regi_cpd_add_column(regi_cpd_kernel *kernel, const regi_cpd_cloud *source, int pivot)
{
    const regi_cpd_block *home = source->points + pivot / REGI_CPD_LANES;
    double *column = kernel->columns + (size_t)kernel->rank * kernel->rows;
    double root = sqrt(kernel->diagonal[pivot]), at[3];
    at[0] = home->x[pivot % REGI_CPD_LANES], at[1] = home->y[pivot % REGI_CPD_LANES];
    at[2] = home->z[pivot % REGI_CPD_LANES];
    for (int b = 0; b < source->blocks; b++)
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            const regi_cpd_block *p = source->points + b;
            column[(size_t)b * REGI_CPD_LANES + (size_t)l] =
                regi_cpd_gauss(at, p->x[l], p->y[l], p->z[l], kernel->inverse);
        }
    for (int j = 0; j < kernel->rank; j++) {
        const double *before = kernel->columns + (size_t)j * kernel->rows;
        regi_cpd_add(column, -before[pivot], before, kernel->rows);
    }
    for (size_t i = 0; i < kernel->rows; i++)
        column[i] = i < (size_t)source->count ? column[i] / root : 0.0;
    for (int i = 0; i < source->count; i++)
        if (kernel->diagonal[i] >= 0)
            kernel->diagonal[i] = regi_cpd_not_below_0(kernel->diagonal[i] - column[i] * column[i]);
    for (int j = 0; j < kernel->rank; j++)
        column[kernel->pivots[j]] = 0; /* but for rounding it is */
    column[pivot] = root;
    kernel->diagonal[pivot] = -1;
    kernel->pivots[kernel->rank++] = pivot;
}

/* Memory for the systems of a kernel of known rank. */
static int regi_cpd_kernel_room(regi_cpd_kernel *kernel)
{
    size_t rank = (size_t)kernel->rank, stride = (rank + REGI_CPD_FOUR - 1) / REGI_CPD_FOUR * REGI_CPD_FOUR;
    kernel->stride = stride;
    kernel->system = (double *)sbi_alloc_zeroed(&kernel->allocator, rank, stride * sizeof(double));
    kernel->scaled = (double *)sbi_alloc(&kernel->allocator, rank, REGI_CPD_SLICE * sizeof(double));
    kernel->weights[0] = (double *)sbi_alloc_zeroed(&kernel->allocator, 3 * stride, sizeof(double));
    if (!kernel->system || !kernel->scaled || !kernel->weights[0])
        return 0;
    kernel->weights[1] = kernel->weights[0] + stride;
    kernel->weights[2] = kernel->weights[1] + stride;
    return 1;
}

REGI_API sb_result regi_cpd_kernel_create(const regi_cpd_cloud *source, double beta, double tolerance, int max_rank,
                                          const sb_allocator *allocator, regi_cpd_kernel *kernel, sb_error *error)
{
    int most = sbi_min_int(max_rank, source->count), pivot = 0, fits;
    memset(kernel, 0, sizeof *kernel);
    kernel->allocator = *allocator;
    kernel->rows = (size_t)source->blocks * REGI_CPD_LANES;
    kernel->inverse = 1 / (2 * beta * beta);
    kernel->diagonal = (double *)sbi_alloc(allocator, kernel->rows, sizeof(double));
    fits = kernel->diagonal != NULL;
    for (size_t i = 0; fits && i < kernel->rows; i++)
        kernel->diagonal[i] = 1;
    while (fits && kernel->rank < most && pivot >= 0) {
        if (kernel->rank == kernel->capacity)
            fits = regi_cpd_grow(kernel, kernel->rank > most / 2 ? most
                                         : kernel->rank > 0      ? 2 * kernel->rank
                                                                 : sbi_min_int(most, REGI_CPD_FIRST));
        pivot = fits ? regi_cpd_next_pivot(kernel, source->count, tolerance) : -1;
        if (pivot >= 0)
            regi_cpd_add_column(kernel, source, pivot);
    }
    if (fits && regi_cpd_kernel_room(kernel))
        return SB_OK;
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d columns of the kernel of %d points", kernel->rank + 1,
                    source->count);
}

/* ---- system ---- */

/* Products of rows a, a2 with rows b, b2 over `count` entries, a multiple of REGI_CPD_FOUR. */
static void regi_cpd_tile(const double *SB_RESTRICT a, const double *SB_RESTRICT a2, const double *SB_RESTRICT b,
                          const double *SB_RESTRICT b2, size_t count, double out[4])
{
    double s[4][REGI_CPD_FOUR];
    for (int l = 0; l < REGI_CPD_FOUR; l++)
        s[0][l] = s[1][l] = s[2][l] = s[3][l] = 0;
    for (size_t i = 0; i < count; i += REGI_CPD_FOUR)
        for (int l = 0; l < REGI_CPD_FOUR; l++) {
            double p = a[i + (size_t)l], p2 = a2[i + (size_t)l], q = b[i + (size_t)l], q2 = b2[i + (size_t)l];
            s[0][l] += p * q;
            s[1][l] += p * q2;
            s[2][l] += p2 * q;
            s[3][l] += p2 * q2;
        }
    for (int k = 0; k < 4; k++)
        out[k] = (s[k][0] + s[k][1]) + (s[k][2] + s[k][3]);
}

/* c[i][j] += sign * row i . row j for i in [first, last), j in [from, to) with j <= i; rows of a lie `stride` apart;
 * first and from are even. */
static void regi_cpd_rows(double *c, size_t c_stride, const double *a, size_t stride, size_t count, double sign,
                          int first, int last, int from, int to)
{
    for (int i = first; i < last; i += 2) {
        int i2 = sbi_min_int(i + 1, last - 1), end = sbi_min_int(to, i2 + 1);
        for (int j = from; j < end; j += 2) {
            int j2 = sbi_min_int(j + 1, end - 1);
            double t[4], *row = c + (size_t)i * c_stride, *row2 = c + (size_t)i2 * c_stride;
            regi_cpd_tile(a + (size_t)i * stride, a + (size_t)i2 * stride, a + (size_t)j * stride,
                          a + (size_t)j2 * stride, count, t);
            row[j] += sign * t[0];
            if (j2 > j && j2 <= i)
                row[j2] += sign * t[1];
            if (i2 > i) {
                row2[j] += sign * t[2];
                if (j2 > j)
                    row2[j2] += sign * t[3];
            }
        }
    }
}

typedef struct regi_cpd_strips {
    regi_cpd_kernel *kernel;
    size_t count; /* rows of the slice */
} regi_cpd_strips;

static void regi_cpd_add_strip(void *user, int index)
{
    const regi_cpd_strips *strips = (const regi_cpd_strips *)user;
    regi_cpd_kernel *kernel = strips->kernel;
    int first = index * REGI_CPD_STRIP, last = sbi_min_int(first + REGI_CPD_STRIP, kernel->rank);
    regi_cpd_rows(kernel->system, kernel->stride, kernel->scaled, REGI_CPD_SLICE, strips->count, 1, first, last, 0,
                  last);
}

/* The lower half of L^T P L + ridge. */
static void regi_cpd_assemble(regi_cpd_kernel *kernel, const double *p, double ridge, const sb_jobs *jobs)
{
    regi_cpd_strips strips;
    double root[REGI_CPD_SLICE];
    int rank = kernel->rank;
    strips.kernel = kernel;
    memset(kernel->system, 0, (size_t)rank * kernel->stride * sizeof(double));
    for (size_t begin = 0; begin < kernel->rows; begin += REGI_CPD_SLICE) {
        strips.count = kernel->rows - begin < REGI_CPD_SLICE ? kernel->rows - begin : (size_t)REGI_CPD_SLICE;
        for (size_t i = 0; i < strips.count; i++)
            root[i] = sqrt(p[begin + i]);
        for (int k = 0; k < rank; k++) {
            const double *column = kernel->columns + (size_t)k * kernel->rows + begin;
            double *scaled = kernel->scaled + (size_t)k * REGI_CPD_SLICE;
            for (size_t i = 0; i < strips.count; i++)
                scaled[i] = root[i] * column[i];
        }
        sbi_run(jobs, regi_cpd_add_strip, &strips, (rank + REGI_CPD_STRIP - 1) / REGI_CPD_STRIP);
    }
    for (int k = 0; k < rank; k++)
        kernel->system[(size_t)k * kernel->stride + (size_t)k] += ridge;
}

/* Row i of the factor between columns from and to; rows up to i are done, and the sums with columns before `from` are
 * subtracted. The ridge keeps every pivot above 0: at least that much is left of it. */
static void regi_cpd_finish_row(double *a, size_t stride, int i, int from, int to, double ridge)
{
    double *row = a + (size_t)i * stride;
    for (int j = from; j < to && j <= i; j++) {
        const double *other = a + (size_t)j * stride;
        double sum = row[j];
        for (int k = from; k < j; k++)
            sum -= row[k] * other[k];
        row[j] = j < i ? sum / other[j] : sqrt(sum > ridge ? sum : ridge);
    }
}

REGI_API void regi_cpd_factor(double *a, int n, size_t stride, double ridge)
{
    for (int from = 0; from < n; from += REGI_CPD_STRIP) {
        int to = sbi_min_int(from + REGI_CPD_STRIP, n);
        for (int first = from; first < n; first += REGI_CPD_STRIP)
            regi_cpd_rows(a, stride, a, stride, (size_t)from, -1, first, sbi_min_int(first + REGI_CPD_STRIP, n), from,
                          to);
        for (int i = from; i < n; i++)
            regi_cpd_finish_row(a, stride, i, from, to, ridge);
    }
}

REGI_API void regi_cpd_back_solve(const double *l, int n, size_t stride, double *b)
{
    for (int i = 0; i < n; i++) {
        const double *row = l + (size_t)i * stride;
        double sum = b[i];
        for (int j = 0; j < i; j++)
            sum -= row[j] * b[j];
        b[i] = sum / row[i];
    }
    for (int i = n - 1; i >= 0; i--) {
        const double *row = l + (size_t)i * stride;
        b[i] /= row[i];
        for (int j = 0; j < i; j++)
            b[j] -= row[j] * b[i];
    }
}

REGI_API double regi_cpd_kernel_solve(regi_cpd_kernel *kernel, const double *p, double *const r[3], double ridge,
                                      const sb_jobs *jobs)
{
    double energy = 0;
    regi_cpd_assemble(kernel, p, ridge, jobs);
    regi_cpd_factor(kernel->system, kernel->rank, kernel->stride, ridge);
    for (int axis = 0; axis < 3; axis++) {
        double *c = kernel->weights[axis];
        for (int k = 0; k < kernel->rank; k++)
            c[k] = regi_cpd_dot(kernel->columns + (size_t)k * kernel->rows, r[axis], kernel->rows);
        regi_cpd_back_solve(kernel->system, kernel->rank, kernel->stride, c);
        energy += regi_cpd_dot(c, c, kernel->stride);
    }
    return energy;
}

REGI_API void regi_cpd_kernel_move(const regi_cpd_kernel *kernel, const regi_cpd_block *points, regi_cpd_block *moved)
{
    int blocks = (int)(kernel->rows / REGI_CPD_LANES);
    memcpy(moved, points, (size_t)blocks * sizeof *moved);
    for (int b = 0; b < blocks; b++)
        for (int k = 0; k < kernel->rank; k++) {
            const double *column = kernel->columns + (size_t)k * kernel->rows + (size_t)b * REGI_CPD_LANES;
            regi_cpd_add(moved[b].x, kernel->weights[0][k], column, REGI_CPD_LANES);
            regi_cpd_add(moved[b].y, kernel->weights[1][k], column, REGI_CPD_LANES);
            regi_cpd_add(moved[b].z, kernel->weights[2][k], column, REGI_CPD_LANES);
        }
}

/* L^-T of the pivots' rows, which are lower triangular: row pivots[k] of column j is 0 for j > k. */
REGI_API void regi_cpd_kernel_spread(regi_cpd_kernel *kernel)
{
    for (int axis = 0; axis < 3; axis++) {
        double *c = kernel->weights[axis];
        for (int k = kernel->rank - 1; k >= 0; k--) {
            const double *column = kernel->columns + (size_t)k * kernel->rows;
            double sum = c[k];
            for (int i = k + 1; i < kernel->rank; i++)
                sum -= column[kernel->pivots[i]] * c[i];
            c[k] = sum / column[kernel->pivots[k]];
        }
    }
}

/* ==== src/register/cpd.c ==== */
/* cpd: coherent point drift; the formulas are those of Myronenko and Song 2010, figures 2 to 4. */

#include <string.h>


enum { REGI_CPD_COOKIE = 0x63706431 };

static const double regi_cpd_least_sigma2 = 1e-10; /* in the frame of the target */

/* z = (x / unit - mean) / size: mean 0, rms 1. */
typedef struct regi_cpd_frame {
    double unit, mean[3], size;
} regi_cpd_frame;

/* y -> linear y + shift, in the frames of the clouds. */
typedef struct regi_cpd_affine {
    double linear[3][3], shift[3];
} regi_cpd_affine;

struct reg_cpd {
    sb_allocator allocator;
    reg_cpd_info info;
    int count;
    regi_cpd_frame source, target;
    regi_cpd_affine map;    /* the identity when non-rigid */
    double inverse;         /* 1 / (2 beta^2) */
    double (*centres)[3];   /* [rank] pivots in the source's frame */
    double (*weights)[3];   /* [rank] */
    sb_vec3 *moved;         /* [count] */
    int *partners;          /* [count] */
    sb_real *probabilities; /* [count] */
    void *memory;
};

/* A fit being made. */
typedef struct regi_cpd_run {
    reg_cpd_options options;
    regi_cpd_frame source_frame, target_frame;
    regi_cpd_cloud source, target;
    regi_cpd_block *moved, *next; /* [source blocks] the source after this iteration and after the next */
    double (*landmarks)[3];       /* [landmark_count] their places in the target's frame */
    int *landmark_slots;          /* [landmark_count] in the order of the source */
    double landmark_weight;       /* 1 / sigma^2 of the landmarks, in the target's frame */
    double *p, *r[3];             /* [rows] P and P X - P Y, with landmarks */
    regi_cpd_affine map;
    double sigma2, energy; /* energy: |L^T W|^2 */
    regi_cpd_kernel kernel;
    regi_cpd_expectation e;
    reg_cpd_info info;
    double start;           /* s */
    sb_vec3 *sort_points;   /* [larger count] */
    uint32_t *sort_scratch; /* [3 larger count] */
    int *slot_of;           /* [source count] */
    void *memory;
} regi_cpd_run;

/* ---- options and input ---- */

REG_API reg_cpd_options reg_default_cpd_options(void)
{
    reg_cpd_options options;
    memset(&options, 0, sizeof options);
    options.kind = REG_CPD_NONRIGID;
    options.outliers = (sb_real)0.1;
    options.beta = 2;
    options.lambda = 3;
    options.kernel_tolerance = (sb_real)1e-4;
    options.max_rank = 1000;
    options.sum_tolerance = (sb_real)1e-5;
    options.tolerance = (sb_real)1e-6;
    options.max_iterations = 300;
    options.max_pairs = 4e8;
    options.cookie = REGI_CPD_COOKIE;
    return options;
}

static sb_result regi_cpd_check_options(const reg_cpd_options *o, sb_error *error)
{
    if (o->cookie != REGI_CPD_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the options were not made by reg_default_cpd_options");
    if ((int)o->kind < REG_CPD_RIGID || (int)o->kind > REG_CPD_NONRIGID)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "kind %d is none of reg_cpd_kind", (int)o->kind);
    if (!(o->outliers >= 0) || !(o->outliers < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the share of outliers is %g, not in [0, 1)", (double)o->outliers);
    if (!(o->beta >= (sb_real)1e-6) || !(o->beta <= (sb_real)1e6))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "beta is %g, not in [1e-6, 1e6]", (double)o->beta);
    if (!(o->lambda >= (sb_real)1e-12) || !(o->lambda <= (sb_real)1e12))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "lambda is %g, not in [1e-12, 1e12]", (double)o->lambda);
    if (!(o->start_sigma >= 0) || !sb_is_finite(o->start_sigma))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "start_sigma is %g", (double)o->start_sigma);
    if (!(o->kernel_tolerance > (sb_real)1e-12) || !(o->kernel_tolerance < 1) || o->max_rank < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "kernel_tolerance %g is not in (1e-12, 1), or max_rank %d below 1",
                        (double)o->kernel_tolerance, o->max_rank);
    if (!(o->sum_tolerance >= 0) || !(o->sum_tolerance <= (sb_real)0.1) || !(o->tolerance >= 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sum_tolerance is %g, not in [0, 0.1], or tolerance %g below 0",
                        (double)o->sum_tolerance, (double)o->tolerance);
    if (o->max_iterations < 0 || !(o->max_seconds >= 0) || !(o->max_pairs >= 0) || (o->max_seconds > 0 && !o->clock))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a cap is below 0, or one of time has no clock");
    return SB_OK;
}

static sb_result regi_cpd_check_cloud(const sb_vec3 *points, int count, const char *name, sb_error *error)
{
    if (!points || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the %s has no points", name);
    for (int i = 0; i < count; i++)
        if (!sb_v3_is_finite(points[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "point %d of the %s is not finite", i, name);
    return SB_OK;
}

static sb_result regi_cpd_check_landmarks(const reg_cpd_options *o, int source_count, sb_error *error)
{
    if (o->landmark_count == 0)
        return SB_OK;
    if (o->landmark_count < 0 || !o->landmark_points || !o->landmark_targets)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d landmarks, or no arrays of them", o->landmark_count);
    if (!(o->landmark_sigma > 0) || !sb_is_finite(o->landmark_sigma))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "landmark_sigma is %g m", (double)o->landmark_sigma);
    for (int i = 0; i < o->landmark_count; i++)
        if (o->landmark_points[i] < 0 || o->landmark_points[i] >= source_count)
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "landmark %d is at point %d of %d", i,
                                 o->landmark_points[i], source_count);
    return regi_cpd_check_cloud(o->landmark_targets, o->landmark_count, "landmarks", error);
}

static sb_result regi_cpd_check(const sb_vec3 *source, int source_count, const sb_vec3 *target, int target_count,
                                const reg_cpd_options *options, sb_error *error)
{
    sb_result result = regi_cpd_check_options(options, error);
    if (result == SB_OK)
        result = regi_cpd_check_cloud(source, source_count, "source", error);
    if (result == SB_OK)
        result = regi_cpd_check_cloud(target, target_count, "target", error);
    if (result == SB_OK)
        result = regi_cpd_check_landmarks(options, source_count, error);
    if (result == SB_OK && (double)source_count * (double)target_count > options->max_pairs)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "%d times %d points are more than max_pairs %g: thin the clouds",
                        source_count, target_count, options->max_pairs);
    return result;
}

/* ---- frames ---- */

static double regi_cpd_largest(double a, double b) { return a > b ? a : b; }

static void regi_cpd_into(const regi_cpd_frame *frame, sb_vec3 point, double z[3])
{
    z[0] = ((double)point.x / frame->unit - frame->mean[0]) / frame->size;
    z[1] = ((double)point.y / frame->unit - frame->mean[1]) / frame->size;
    z[2] = ((double)point.z / frame->unit - frame->mean[2]) / frame->size;
}

static sb_vec3 regi_cpd_out_of(const regi_cpd_frame *frame, const double z[3])
{
    return sb_v3((sb_real)((z[0] * frame->size + frame->mean[0]) * frame->unit),
                 (sb_real)((z[1] * frame->size + frame->mean[1]) * frame->unit),
                 (sb_real)((z[2] * frame->size + frame->mean[2]) * frame->unit));
}

/* Mean in units of frame->unit. */
static void regi_cpd_centre(const sb_vec3 *points, int count, regi_cpd_frame *frame)
{
    for (int k = 0; k < 3; k++)
        frame->mean[k] = 0;
    for (int i = 0; i < count; i++) {
        frame->mean[0] += ((double)points[i].x / frame->unit - frame->mean[0]) / (i + 1);
        frame->mean[1] += ((double)points[i].y / frame->unit - frame->mean[1]) / (i + 1);
        frame->mean[2] += ((double)points[i].z / frame->unit - frame->mean[2]) / (i + 1);
    }
}

/* Size 0 for points in one place. */
static regi_cpd_frame regi_cpd_measure(const sb_vec3 *points, int count)
{
    regi_cpd_frame frame;
    double sum = 0, z[3];
    memset(&frame, 0, sizeof frame);
    for (int i = 0; i < count; i++) {
        frame.unit = regi_cpd_largest(frame.unit, fabs((double)points[i].x));
        frame.unit = regi_cpd_largest(frame.unit, fabs((double)points[i].y));
        frame.unit = regi_cpd_largest(frame.unit, fabs((double)points[i].z));
    }
    if (!(frame.unit > 0))
        frame.unit = 1;
    frame.size = 1;
    regi_cpd_centre(points, count, &frame);
    for (int i = 0; i < count; i++) {
        regi_cpd_into(&frame, points[i], z);
        sum += z[0] * z[0] + z[1] * z[1] + z[2] * z[2];
    }
    frame.size = sqrt(sum / count);
    if (!(frame.size > 1e-14)) /* the rounding of the mean */
        frame.size = 0;
    return frame;
}

/* The frames of both clouds. A cloud in one place has no size of its own and takes the other's. */
static void regi_cpd_set_frames(regi_cpd_run *run, const sb_vec3 *source, int source_count, const sb_vec3 *target,
                                int target_count)
{
    regi_cpd_frame y = regi_cpd_measure(source, source_count), x = regi_cpd_measure(target, target_count);
    if (!(y.size > 0)) {
        y.unit = x.size > 0 ? x.unit : y.unit;
        y.size = x.size > 0 ? x.size : 1.0;
        regi_cpd_centre(source, source_count, &y);
    }
    if (run->options.shared_frame) {
        x = y;
    } else if (run->options.kind == REG_CPD_RIGID || !(x.size > 0)) {
        x.unit = y.unit;
        x.size = y.size;
        regi_cpd_centre(target, target_count, &x);
    }
    run->source_frame = y;
    run->target_frame = x;
}

/* ---- memory ---- */

/* Hands out, or measures, all arrays whose size is known beforehand. */
static void regi_cpd_layout(regi_cpd_run *run, sbi_arena *arena)
{
    size_t m = (size_t)run->source.count, n = (size_t)run->target.count, blocks = (size_t)run->source.blocks;
    size_t more = m > n ? m : n, landmarks = (size_t)run->options.landmark_count, rows = blocks * REGI_CPD_LANES;
    run->source.order = (int *)sbi_arena_take(arena, m, sizeof(int));
    run->source.points = (regi_cpd_block *)sbi_arena_take(arena, blocks, sizeof(regi_cpd_block));
    run->source.boxes = (regi_cpd_box *)sbi_arena_take(arena, blocks, sizeof(regi_cpd_box));
    run->target.order = (int *)sbi_arena_take(arena, n, sizeof(int));
    run->target.points = (regi_cpd_block *)sbi_arena_take(arena, (size_t)run->target.blocks, sizeof(regi_cpd_block));
    run->target.boxes = (regi_cpd_box *)sbi_arena_take(arena, (size_t)run->target.blocks, sizeof(regi_cpd_box));
    run->moved = (regi_cpd_block *)sbi_arena_take(arena, blocks, sizeof(regi_cpd_block));
    run->next = (regi_cpd_block *)sbi_arena_take(arena, blocks, sizeof(regi_cpd_block));
    run->landmarks = (double(*)[3])sbi_arena_take(arena, landmarks, 3 * sizeof(double));
    run->landmark_slots = (int *)sbi_arena_take(arena, landmarks, sizeof(int));
    run->p = (double *)sbi_arena_take(arena, rows, sizeof(double));
    for (int k = 0; k < 3; k++)
        run->r[k] = (double *)sbi_arena_take(arena, rows, sizeof(double));
    run->e.sums = (regi_cpd_sums *)sbi_arena_take(arena, blocks, REGI_CPD_CHUNKS * sizeof(regi_cpd_sums));
    run->e.terms = (double(*)[REGI_CPD_LANES])sbi_arena_take(arena, rows, REGI_CPD_CHUNKS * sizeof(double));
    run->e.near_blocks = (int *)sbi_arena_take(arena, blocks, REGI_CPD_CHUNKS * sizeof(int));
    run->e.best = (regi_cpd_best *)sbi_arena_take(arena, blocks, sizeof(regi_cpd_best));
    run->sort_points = (sb_vec3 *)sbi_arena_take(arena, more, sizeof(sb_vec3));
    run->sort_scratch = (uint32_t *)sbi_arena_take(arena, more, 3 * sizeof(uint32_t));
    run->slot_of = (int *)sbi_arena_take(arena, m, sizeof(int));
}

static sb_result regi_cpd_allocate(regi_cpd_run *run, sb_error *error)
{
    sbi_arena arena;
    memset(&arena, 0, sizeof arena);
    regi_cpd_layout(run, &arena);
    run->memory = arena.overflow ? NULL : sbi_alloc(&run->options.allocator, arena.used, 1);
    if (!run->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for clouds of %d and %d points", run->source.count,
                        run->target.count);
    arena.base = (unsigned char *)run->memory;
    arena.used = 0;
    regi_cpd_layout(run, &arena);
    return SB_OK;
}

/* ---- start ---- */

/* Sorts the points and puts them into blocks, in their frame. */
static sb_result regi_cpd_fill(regi_cpd_run *run, regi_cpd_cloud *cloud, const sb_vec3 *points,
                               const regi_cpd_frame *frame, sb_error *error)
{
    double z[3], most = 0;
    for (int i = 0; i < cloud->count; i++) {
        regi_cpd_into(frame, points[i], z);
        run->sort_points[i] = sb_v3((sb_real)z[0], (sb_real)z[1], (sb_real)z[2]);
        for (int k = 0; k < 3; k++)
            most = z[k] - z[k] == 0.0 ? regi_cpd_largest(most, fabs(z[k])) : 1.7976931348623157e308;
        if (!(most < 1e15)) /* source and target far apart: squares must keep the digits of the smaller */
            return sbi_fail(error, SB_ERROR_ARGUMENT, "the clouds are too far apart or too unlike in size");
    }
    sbi_embed_sort(run->sort_points, cloud->count, cloud->order, run->sort_scratch);
    for (int i = 0; i < cloud->blocks * REGI_CPD_LANES; i++) {
        regi_cpd_block *block = cloud->points + i / REGI_CPD_LANES;
        regi_cpd_into(frame, points[cloud->order[sbi_min_int(i, cloud->count - 1)]], z);
        block->x[i % REGI_CPD_LANES] = z[0];
        block->y[i % REGI_CPD_LANES] = z[1];
        block->z[i % REGI_CPD_LANES] = z[2];
    }
    regi_cpd_bound(cloud->points, cloud->blocks, cloud->boxes);
    return SB_OK;
}

static sb_result regi_cpd_fill_landmarks(regi_cpd_run *run, sb_error *error)
{
    const reg_cpd_options *o = &run->options;
    double sigma = (double)o->landmark_sigma / run->target_frame.unit / run->target_frame.size;
    for (int i = 0; i < run->source.count; i++)
        run->slot_of[run->source.order[i]] = i;
    for (int i = 0; i < o->landmark_count; i++) {
        double *z = run->landmarks[i];
        run->landmark_slots[i] = run->slot_of[o->landmark_points[i]];
        regi_cpd_into(&run->target_frame, o->landmark_targets[i], z);
        if (!(fabs(z[0]) < 1e15) || !(fabs(z[1]) < 1e15) || !(fabs(z[2]) < 1e15))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "landmark %d is too far from the target", i);
    }
    if (o->landmark_count > 0) {
        if (!(sigma > 1e-9)) /* a weight that the system can take */
            return sbi_fail(error, SB_ERROR_ARGUMENT, "landmark_sigma %g m is below 1e-9 of the target's size",
                            (double)o->landmark_sigma);
        run->landmark_weight = 1 / (sigma * sigma);
    }
    return SB_OK;
}

/* Mean squared distance, per axis, of all pairs of points. */
static double regi_cpd_spread(const regi_cpd_cloud *a, const regi_cpd_cloud *b)
{
    const regi_cpd_cloud *cloud[2];
    double mean[2][3], squares = 0, gap = 0;
    cloud[0] = a, cloud[1] = b;
    for (int c = 0; c < 2; c++) {
        double sum = 0;
        mean[c][0] = mean[c][1] = mean[c][2] = 0;
        for (int i = 0; i < cloud[c]->count; i++) {
            const regi_cpd_block *p = cloud[c]->points + i / REGI_CPD_LANES;
            int l = i % REGI_CPD_LANES;
            mean[c][0] += p->x[l] / cloud[c]->count;
            mean[c][1] += p->y[l] / cloud[c]->count;
            mean[c][2] += p->z[l] / cloud[c]->count;
            sum += p->x[l] * p->x[l] + p->y[l] * p->y[l] + p->z[l] * p->z[l];
        }
        squares += sum / cloud[c]->count;
    }
    for (int k = 0; k < 3; k++)
        gap += mean[0][k] * mean[1][k];
    return (squares - 2 * gap) / 3;
}

static sb_result regi_cpd_prepare(regi_cpd_run *run, const sb_vec3 *source, const sb_vec3 *target, sb_error *error)
{
    const reg_cpd_options *o = &run->options;
    double sigma = (double)o->start_sigma / run->target_frame.unit / run->target_frame.size;
    sb_result result = regi_cpd_allocate(run, error);
    if (result == SB_OK)
        result = regi_cpd_fill(run, &run->source, source, &run->source_frame, error);
    if (result == SB_OK)
        result = regi_cpd_fill(run, &run->target, target, &run->target_frame, error);
    if (result == SB_OK)
        result = regi_cpd_fill_landmarks(run, error);
    if (result == SB_OK && o->kind == REG_CPD_NONRIGID) {
        double begun = o->clock ? o->clock() : 0.0;
        result = regi_cpd_kernel_create(&run->source, (double)o->beta, (double)o->kernel_tolerance, o->max_rank,
                                        &o->allocator, &run->kernel, error);
        run->info.rank = run->kernel.rank;
        run->info.kernel_seconds = o->clock ? o->clock() - begun : 0.0;
    }
    if (result != SB_OK)
        return result;
    for (int k = 0; k < 3; k++)
        run->map.linear[k][k] = 1;
    memcpy(run->moved, run->source.points, (size_t)run->source.blocks * sizeof *run->moved);
    run->sigma2 = sigma > 0 ? sigma * sigma : regi_cpd_spread(&run->source, &run->target);
    if (!(run->sigma2 > regi_cpd_least_sigma2))
        run->sigma2 = regi_cpd_least_sigma2;
    return SB_OK;
}

/* ---- expectation ---- */

/* 1 / sigma^2 sum |T y - x|^2 of the landmarks. */
static double regi_cpd_landmark_energy(const regi_cpd_run *run)
{
    double sum = 0;
    for (int i = 0; i < run->options.landmark_count; i++) {
        int slot = run->landmark_slots[i], lane = slot % REGI_CPD_LANES;
        const regi_cpd_block *block = run->moved + slot / REGI_CPD_LANES;
        const double *z = run->landmarks[i];
        double x = block->x[lane] - z[0], y = block->y[lane] - z[1], w = block->z[lane] - z[2];
        sum += x * x + y * y + w * w;
    }
    return run->landmark_weight * sum;
}

static sb_result regi_cpd_look(regi_cpd_run *run, int with_partners, sb_error *error)
{
    const reg_cpd_options *o = &run->options;
    regi_cpd_expectation e = run->e;
    double m = run->source.count, n = run->target.count, w = (double)o->outliers, area;
    double turn = 6.283185307179586 * run->sigma2;
    area = turn * sqrt(turn); /* the reciprocal of a Gaussian's peak */
    e.source = &run->source;
    e.target = &run->target;
    e.moved = run->moved;
    e.sigma2 = run->sigma2;
    e.outlier = area * w / (1 - w) * m / n;
    e.tolerance = (double)o->sum_tolerance;
    e.best = with_partners ? run->e.best : NULL;
    regi_cpd_bound(run->moved, run->source.blocks, run->source.boxes);
    regi_cpd_expect(&e, &o->jobs);
    memcpy(run->e.totals, e.totals, sizeof e.totals);
    if (!(e.totals[0].explained > 1e-12 * n))
        return sbi_fail(error, SB_ERROR_NOT_CONVERGED, "no target point is near enough the source: all are outliers");
    run->info.pairs += e.totals[0].pairs;
    run->info.explained = (sb_real)e.totals[0].explained;
    run->info.sigma = (sb_real)(sqrt(run->sigma2) * run->target_frame.size * run->target_frame.unit);
    run->info.objective = e.totals[0].logs + n * sbi_dense_log(m * area / (1 - w)) +
                          0.5 * ((double)o->lambda * run->energy + regi_cpd_landmark_energy(run));
    return SB_OK;
}

/* ---- maximisation ---- */

/* p and r = sum P x - p T, with the landmarks as further partners of that weight. */
static void regi_cpd_collect(regi_cpd_run *run)
{
    double weight = run->sigma2 * run->landmark_weight;
    for (int b = 0; b < run->source.blocks; b++) {
        size_t first = (size_t)b * REGI_CPD_LANES, bytes = sizeof run->e.sums[b].p;
        memcpy(run->p + first, run->e.sums[b].p, bytes);
        memcpy(run->r[0] + first, run->e.sums[b].x, bytes);
        memcpy(run->r[1] + first, run->e.sums[b].y, bytes);
        memcpy(run->r[2] + first, run->e.sums[b].z, bytes);
    }
    for (int i = 0; i < run->options.landmark_count; i++) {
        int slot = run->landmark_slots[i], lane = slot % REGI_CPD_LANES;
        const regi_cpd_block *block = run->moved + slot / REGI_CPD_LANES;
        run->p[slot] += weight;
        run->r[0][slot] += weight * (run->landmarks[i][0] - block->x[lane]);
        run->r[1][slot] += weight * (run->landmarks[i][1] - block->y[lane]);
        run->r[2][slot] += weight * (run->landmarks[i][2] - block->z[lane]);
    }
}

/* Moments of the expected pairs: `cross` of the target's with the source's points, `spread` of the source's. */
typedef struct regi_cpd_moments {
    double x[3], y[3]; /* weighted means */
    double cross[3][3], spread[3][3];
} regi_cpd_moments;

static void regi_cpd_weigh(const regi_cpd_run *run, regi_cpd_moments *s)
{
    double total = 0;
    memset(s, 0, sizeof *s);
    for (int pass = 0; pass < 2; pass++) {
        for (int i = 0; i < run->source.count; i++) {
            int b = i / REGI_CPD_LANES, l = i % REGI_CPD_LANES;
            const regi_cpd_block *from = run->source.points + b, *at = run->moved + b;
            double p = run->p[i], y[3], x[3]; /* x: p times the mean place of the partners */
            y[0] = from->x[l], y[1] = from->y[l], y[2] = from->z[l];
            x[0] = run->r[0][i] + p * at->x[l], x[1] = run->r[1][i] + p * at->y[l];
            x[2] = run->r[2][i] + p * at->z[l];
            total += pass == 0 ? p : 0.0;
            for (int j = 0; j < 3; j++) {
                s->x[j] += pass == 0 ? x[j] : 0.0;
                s->y[j] += pass == 0 ? p * y[j] : 0.0;
                for (int k = 0; k < 3 && pass == 1; k++) {
                    s->cross[j][k] += (x[j] - p * s->x[j]) * (y[k] - s->y[k]);
                    s->spread[j][k] += p * (y[j] - s->y[j]) * (y[k] - s->y[k]);
                }
            }
        }
        for (int j = 0; j < 3 && pass == 0; j++) {
            s->x[j] /= total;
            s->y[j] /= total;
        }
    }
}

/* The rotation nearest to the cross moments, times the scale. Where they say nothing the last one stays. */
static void regi_cpd_turn(regi_cpd_run *run, const regi_cpd_moments *s)
{
    double most = 0, trace = 0, spread = s->spread[0][0] + s->spread[1][1] + s->spread[2][2], scale = 1;
    sb_mat3 a, u, v, rotation;
    sb_vec3 stretches;
    for (int j = 0; j < 9; j++)
        most = regi_cpd_largest(most, fabs(s->cross[j / 3][j % 3]));
    if (!(most > 0))
        return;
    for (int j = 0; j < 9; j++)
        a.m[j / 3][j % 3] = (sb_real)(s->cross[j / 3][j % 3] / most);
    sb_m3_svd(a, &u, &stretches, &v);
    rotation = sb_m3_mult(u, v);
    for (int j = 0; j < 9; j++)
        trace += s->cross[j / 3][j % 3] * (double)rotation.m[j / 3][j % 3];
    if (run->options.kind == REG_CPD_SIMILARITY && trace > 0 && spread > 0)
        scale = trace / spread;
    for (int j = 0; j < 9; j++)
        run->map.linear[j / 3][j % 3] = scale * (double)rotation.m[j / 3][j % 3];
}

/* B += (A - B C) C^-1 of the moments A and C. C is made regular by a little: directions in which the source has no
 * extent keep the B they had, all others get theirs to 1e-10 in the first iteration, and further digits in the next. */
static void regi_cpd_stretch(regi_cpd_run *run, const regi_cpd_moments *s)
{
    double ridge = 1e-10 * (s->spread[0][0] + s->spread[1][1] + s->spread[2][2]), c[3][4], row[3];
    if (!(ridge > 0))
        return;
    for (int j = 0; j < 3; j++)
        for (int k = 0; k < 3; k++)
            c[j][k] = s->spread[j][k] + (j == k ? ridge : 0.0);
    regi_cpd_factor(c[0], 3, 4, ridge);
    for (int j = 0; j < 3; j++) {
        for (int k = 0; k < 3; k++) {
            row[k] = s->cross[j][k];
            for (int i = 0; i < 3; i++)
                row[k] -= run->map.linear[j][i] * s->spread[i][k];
        }
        regi_cpd_back_solve(c[0], 3, 4, row);
        for (int k = 0; k < 3; k++)
            run->map.linear[j][k] += row[k];
    }
}

static void regi_cpd_map(const regi_cpd_affine *map, const double y[3], double out[3])
{
    for (int j = 0; j < 3; j++)
        out[j] = map->linear[j][0] * y[0] + map->linear[j][1] * y[1] + map->linear[j][2] * y[2] + map->shift[j];
}

static void regi_cpd_move_linear(regi_cpd_run *run)
{
    regi_cpd_moments s;
    regi_cpd_weigh(run, &s);
    if (run->options.kind == REG_CPD_AFFINE)
        regi_cpd_stretch(run, &s);
    else
        regi_cpd_turn(run, &s);
    for (int j = 0; j < 3; j++) {
        run->map.shift[j] = s.x[j];
        for (int k = 0; k < 3; k++)
            run->map.shift[j] -= run->map.linear[j][k] * s.y[k];
    }
    for (int b = 0; b < run->source.blocks; b++)
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            const regi_cpd_block *from = run->source.points + b;
            double y[3], x[3];
            y[0] = from->x[l], y[1] = from->y[l], y[2] = from->z[l];
            regi_cpd_map(&run->map, y, x);
            run->next[b].x[l] = x[0], run->next[b].y[l] = x[1], run->next[b].z[l] = x[2];
        }
}

static void regi_cpd_move_freely(regi_cpd_run *run)
{
    for (int b = 0; b < run->source.blocks; b++)
        for (int l = 0; l < REGI_CPD_LANES; l++) { /* from distances to T to distances to Y */
            const regi_cpd_block *from = run->source.points + b, *at = run->moved + b;
            size_t i = (size_t)b * REGI_CPD_LANES + (size_t)l;
            run->r[0][i] += run->p[i] * (at->x[l] - from->x[l]);
            run->r[1][i] += run->p[i] * (at->y[l] - from->y[l]);
            run->r[2][i] += run->p[i] * (at->z[l] - from->z[l]);
        }
    run->energy = regi_cpd_kernel_solve(&run->kernel, run->p, run->r, (double)run->options.lambda * run->sigma2,
                                        &run->options.jobs);
    regi_cpd_kernel_move(&run->kernel, run->source.points, run->next);
}

/* sigma^2 = sum P |x - T'|^2 / (3 sum P), by the way d from T to the new T': sum P |x - T|^2 - 2 d.r + P |d|^2. */
static void regi_cpd_narrow(regi_cpd_run *run)
{
    double sum = run->e.totals[0].squares;
    for (int b = 0; b < run->source.blocks; b++)
        for (int l = 0; l < REGI_CPD_LANES; l++) {
            const regi_cpd_sums *s = run->e.sums + b;
            double x = run->next[b].x[l] - run->moved[b].x[l], y = run->next[b].y[l] - run->moved[b].y[l];
            double z = run->next[b].z[l] - run->moved[b].z[l];
            sum += s->p[l] * (x * x + y * y + z * z) - 2 * (s->x[l] * x + s->y[l] * y + s->z[l] * z);
        }
    run->sigma2 = sum / (3 * run->e.totals[0].explained);
    if (!(run->sigma2 > regi_cpd_least_sigma2))
        run->sigma2 = regi_cpd_least_sigma2;
}

/* ---- iteration ---- */

static void regi_cpd_step(regi_cpd_run *run)
{
    regi_cpd_block *swap = run->moved;
    regi_cpd_collect(run);
    if (run->options.kind == REG_CPD_NONRIGID)
        regi_cpd_move_freely(run);
    else
        regi_cpd_move_linear(run);
    regi_cpd_narrow(run);
    run->moved = run->next;
    run->next = swap;
    run->info.iterations++;
}

/* 1 when the last iteration was the last one; why is in info.stop. */
static int regi_cpd_is_done(regi_cpd_run *run)
{
    const reg_cpd_options *o = &run->options;
    if (!(run->sigma2 > regi_cpd_least_sigma2))
        run->info.stop = REG_CPD_EXACT;
    else if (run->info.iterations > 0 && run->info.change <= o->tolerance)
        run->info.stop = REG_CPD_CONVERGED;
    else if (run->info.iterations >= o->max_iterations)
        run->info.stop = REG_CPD_ITERATIONS;
    else if (o->max_seconds > 0 && run->info.seconds >= o->max_seconds)
        run->info.stop = REG_CPD_TIME;
    else
        return 0;
    return run->info.iterations > 0 || o->max_iterations == 0;
}

static sb_result regi_cpd_iterate(regi_cpd_run *run, sb_error *error)
{
    const reg_cpd_options *o = &run->options;
    sb_result result = regi_cpd_look(run, 0, error);
    while (result == SB_OK && !regi_cpd_is_done(run)) {
        double before = run->info.objective;
        regi_cpd_step(run);
        result = regi_cpd_look(run, 0, error);
        run->info.change = (sb_real)((before - run->info.objective) / run->target.count);
        run->info.seconds = o->clock ? o->clock() - run->start : 0.0;
        if (result == SB_OK && o->progress && o->progress(o->progress_user, &run->info) != 0)
            return sbi_fail(error, SB_ERROR_CANCELLED, "stopped by the progress callback after %d iterations",
                            run->info.iterations);
    }
    return result == SB_OK ? regi_cpd_look(run, 1, error) : result;
}

/* ---- result ---- */

static void regi_cpd_fit_layout(reg_cpd *fit, sbi_arena *arena)
{
    size_t count = (size_t)fit->count, rank = (size_t)fit->info.rank;
    fit->centres = (double(*)[3])sbi_arena_take(arena, rank, 3 * sizeof(double));
    fit->weights = (double(*)[3])sbi_arena_take(arena, rank, 3 * sizeof(double));
    fit->moved = (sb_vec3 *)sbi_arena_take(arena, count, sizeof(sb_vec3));
    fit->partners = (int *)sbi_arena_take(arena, count, sizeof(int));
    fit->probabilities = (sb_real *)sbi_arena_take(arena, count, sizeof(sb_real));
}

static reg_cpd *regi_cpd_fit_allocate(const regi_cpd_run *run)
{
    const sb_allocator *allocator = &run->options.allocator;
    reg_cpd *fit = (reg_cpd *)sbi_alloc_zeroed(allocator, 1, sizeof(reg_cpd));
    sbi_arena arena;
    if (!fit)
        return NULL;
    memset(&arena, 0, sizeof arena);
    fit->allocator = *allocator;
    fit->info = run->info;
    fit->count = run->source.count;
    regi_cpd_fit_layout(fit, &arena);
    fit->memory = arena.overflow ? NULL : sbi_alloc(allocator, arena.used, 1);
    if (!fit->memory) {
        sbi_free(allocator, fit);
        return NULL;
    }
    arena.base = (unsigned char *)fit->memory;
    arena.used = 0;
    regi_cpd_fit_layout(fit, &arena);
    return fit;
}

/* Clouds near the ends of sb_real have fits beyond them. */
static sb_result regi_cpd_check_range(const regi_cpd_run *run, sb_error *error)
{
    for (int i = 0; i < run->source.count; i++) {
        const regi_cpd_block *at = run->moved + i / REGI_CPD_LANES;
        int l = i % REGI_CPD_LANES;
        double z[3];
        z[0] = at->x[l], z[1] = at->y[l], z[2] = at->z[l];
        if (!sb_v3_is_finite(regi_cpd_out_of(&run->target_frame, z)))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, run->source.order[i],
                                 "point %d of the source would move beyond what numbers hold", run->source.order[i]);
    }
    if (!sb_is_finite(run->info.sigma))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "sigma is beyond what numbers hold");
    return SB_OK;
}

static sb_result regi_cpd_finish(regi_cpd_run *run, reg_cpd **out, sb_error *error)
{
    sb_result result = regi_cpd_check_range(run, error);
    reg_cpd *fit = result == SB_OK ? regi_cpd_fit_allocate(run) : NULL;
    if (result != SB_OK)
        return result;
    if (!fit)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the fit of %d points", run->source.count);
    fit->source = run->source_frame;
    fit->target = run->target_frame;
    fit->map = run->map;
    fit->inverse = run->kernel.inverse;
    for (int i = 0; i < fit->count; i++) {
        int b = i / REGI_CPD_LANES, l = i % REGI_CPD_LANES, index = run->source.order[i];
        double z[3];
        z[0] = run->moved[b].x[l], z[1] = run->moved[b].y[l], z[2] = run->moved[b].z[l];
        fit->moved[index] = regi_cpd_out_of(&fit->target, z);
        fit->partners[index] = run->e.best[b].target[l];
        fit->probabilities[index] = (sb_real)run->e.best[b].probability[l];
    }
    if (fit->info.rank > 0)
        regi_cpd_kernel_spread(&run->kernel);
    for (int k = 0; k < fit->info.rank; k++) {
        int b = run->kernel.pivots[k] / REGI_CPD_LANES, l = run->kernel.pivots[k] % REGI_CPD_LANES;
        fit->centres[k][0] = run->source.points[b].x[l];
        fit->centres[k][1] = run->source.points[b].y[l];
        fit->centres[k][2] = run->source.points[b].z[l];
        for (int axis = 0; axis < 3; axis++)
            fit->weights[k][axis] = run->kernel.weights[axis][k];
    }
    *out = fit;
    return SB_OK;
}

REG_API sb_result reg_cpd_fit(const sb_vec3 *source, int source_count, const sb_vec3 *target, int target_count,
                              const reg_cpd_options *options, reg_cpd **fit, sb_error *error)
{
    regi_cpd_run run;
    sb_result result;
    memset(&run, 0, sizeof run);
    run.options = options ? *options : reg_default_cpd_options();
    if (!fit)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "no place for the fit");
    result = regi_cpd_check(source, source_count, target, target_count, &run.options, error);
    if (result != SB_OK)
        return result;
    run.start = run.options.clock ? run.options.clock() : 0.0;
    run.source.count = source_count;
    run.source.blocks = (source_count - 1) / REGI_CPD_LANES + 1;
    run.target.count = target_count;
    run.target.blocks = (target_count - 1) / REGI_CPD_LANES + 1;
    run.kernel.allocator = run.options.allocator;
    regi_cpd_set_frames(&run, source, source_count, target, target_count);
    result = regi_cpd_prepare(&run, source, target, error);
    if (result == SB_OK)
        result = regi_cpd_iterate(&run, error);
    if (result == SB_OK)
        result = regi_cpd_finish(&run, fit, error);
    regi_cpd_kernel_free(&run.kernel);
    sbi_free(&run.options.allocator, run.memory);
    return result;
}

REG_API void reg_cpd_destroy(reg_cpd *fit)
{
    sb_allocator allocator;
    if (!fit)
        return;
    allocator = fit->allocator;
    sbi_free(&allocator, fit->memory);
    sbi_free(&allocator, fit);
}

REG_API reg_cpd_info reg_cpd_get_info(const reg_cpd *fit)
{
    reg_cpd_info none;
    if (!fit) {
        memset(&none, 0, sizeof none);
        return none;
    }
    return fit->info;
}
REG_API const sb_vec3 *reg_cpd_moved(const reg_cpd *fit) { return fit ? fit->moved : NULL; }
REG_API const int *reg_cpd_partners(const reg_cpd *fit) { return fit ? fit->partners : NULL; }
REG_API const sb_real *reg_cpd_probabilities(const reg_cpd *fit) { return fit ? fit->probabilities : NULL; }

REG_API void reg_cpd_linear(const reg_cpd *fit, sb_mat3 *linear, sb_vec3 *translation)
{
    const regi_cpd_frame *from, *to;
    double ratio, at[3];
    if (!fit || !linear || !translation)
        return;
    from = &fit->source, to = &fit->target;
    ratio = to->unit / from->unit * (to->size / from->size);
    for (int j = 0; j < 3; j++) {
        at[j] = to->mean[j] + to->size * fit->map.shift[j]; /* in units of the target */
        for (int k = 0; k < 3; k++) {
            linear->m[j][k] = (sb_real)(ratio * fit->map.linear[j][k]);
            at[j] -= to->size / from->size * fit->map.linear[j][k] * from->mean[k];
        }
    }
    *translation = sb_v3((sb_real)(to->unit * at[0]), (sb_real)(to->unit * at[1]), (sb_real)(to->unit * at[2]));
}

REG_API void reg_cpd_apply(const reg_cpd *fit, const sb_vec3 *points, int count, sb_vec3 *moved)
{
    if (!fit || !points || !moved)
        return;
    for (int i = 0; i < count; i++) {
        double y[3], out[3];
        regi_cpd_into(&fit->source, points[i], y);
        regi_cpd_map(&fit->map, y, out);
        for (int k = 0; k < fit->info.rank; k++) {
            const double *centre = fit->centres[k], *weight = fit->weights[k];
            double dx = y[0] - centre[0], dy = y[1] - centre[1], dz = y[2] - centre[2];
            double g = sbi_dense_exp(-(dx * dx + dy * dy + dz * dz) * fit->inverse);
            for (int axis = 0; axis < 3; axis++)
                out[axis] += g * weight[axis];
        }
        moved[i] = regi_cpd_out_of(&fit->target, out);
    }
}

/* ==== src/register/pieces.h ==== */
/* pieces: what is registered of a body that is cut. Floor 6, internal.
 *
 * All pieces of an element have its shape, one upon the other at rest, so that boundaries of such a mesh are not its
 * skin, and points are to be held by the piece that has their material. */
#ifndef REG_PIECES_H
#define REG_PIECES_H


#if defined(REG_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
typedef struct regi_pieces {
    const sb_body *body;
    const sb_mesh *mesh; /* of sbi_body_copy_mesh; both borrowed */
    int *cells;          /* [elements] of the body; NULL: it is not cut */
    sb_allocator allocator;
} regi_pieces;

REGI_API sb_result regi_pieces_make(const sb_body *body, const sb_mesh *mesh, const sb_allocator *allocator,
                                    regi_pieces *pieces, sb_error *error);
REGI_API void regi_pieces_free(regi_pieces *pieces); /* safe on zeros */
/* The element that has the material at xi of an element; where it was taken out, the nearest of its pieces. */
REGI_API int regi_pieces_find(const regi_pieces *pieces, int element, const sb_real xi[3]);
/* The organ's surface without what was taken out: of `surface`, or, where that is NULL, of the mesh before it was cut,
 * with its nodes in skin->nodes. Release with sb_boundary_free. Errors as of sb_mesh_boundary and sb_embedding_create.
 */
REGI_API sb_result regi_pieces_skin(const regi_pieces *pieces, const sb_mesh *surface, sb_boundary *skin,
                                    sb_error *error);
#endif

#endif /* REG_PIECES_H */

/* ==== src/register/pieces.c ==== */
/* pieces: see pieces.h. */

#include <string.h>

REGI_API sb_result regi_pieces_make(const sb_body *body, const sb_mesh *mesh, const sb_allocator *allocator,
                                    regi_pieces *pieces, sb_error *error)
{
    memset(pieces, 0, sizeof *pieces);
    pieces->body = body;
    pieces->mesh = mesh;
    pieces->allocator = *allocator;
    if (!sbi_body_has_pieces(body))
        return SB_OK;
    pieces->cells = (int *)sbi_alloc(allocator, (size_t)mesh->element_count, sizeof(int));
    if (!pieces->cells)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the pieces of a body");
    sbi_body_list_cells(body, pieces->cells);
    return SB_OK;
}

REGI_API void regi_pieces_free(regi_pieces *pieces)
{
    if (pieces->cells)
        sbi_free(&pieces->allocator, pieces->cells);
    memset(pieces, 0, sizeof *pieces);
}

REGI_API int regi_pieces_find(const regi_pieces *pieces, int element, const sb_real xi[3])
{
    int low = 0, high = pieces->mesh->element_count - 1, cell;
    if (!pieces->cells)
        return element;
    cell = sb_body_find_cell(pieces->body, pieces->cells[element], xi);
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (pieces->cells[middle] < cell)
            low = middle + 1;
        else
            high = middle;
    }
    return pieces->cells[low] == cell ? low : element;
}

/* ---- the skin ---- */

/* Keeps the faces that have no node in lost[nodes]. */
static void regi_pieces_drop_faces(const unsigned char *lost, sb_boundary *skin)
{
    sb_mesh *surface = &skin->surface;
    size_t width = (size_t)sb_mesh_element_width(surface);
    int kept = 0;
    for (int f = 0; f < surface->element_count; f++) {
        const int *nodes = surface->elements + width * (size_t)f;
        int whole = 1;
        for (size_t a = 0; a < width; a++)
            whole &= !lost[nodes[a]];
        if (!whole)
            continue;
        memmove(surface->elements + width * (size_t)kept, nodes, width * sizeof(int));
        if (skin->elements) {
            skin->elements[kept] = skin->elements[f];
            skin->faces[kept] = skin->faces[f];
        }
        kept++;
    }
    surface->element_count = kept;
}

/* Marks what an embedding says of the nodes: taken out of the mesh that it is of. */
static sb_result regi_pieces_mark(const regi_pieces *pieces, const sb_mesh *mesh, const int *cells,
                                  const sb_mesh *surface, unsigned char *lost, sb_error *error)
{
    sb_embedding_def embed = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_result result;
    embed.mesh = mesh;
    embed.points = surface->nodes;
    embed.point_count = surface->node_count;
    embed.kind = SB_EMBED_PLAIN;
    embed.allocator = pieces->allocator;
    embed.jobs = *sbi_body_jobs(pieces->body);
    result = sb_embedding_create(&embed, &embedding, error);
    for (int i = 0; i < surface->node_count && result == SB_OK; i++) {
        sb_embedded_point point;
        (void)sb_embedding_get_point(embedding, i, &point);
        lost[i] =
            sbi_body_find_holder(pieces->body, mesh, point.element, cells ? cells[point.element] : 0, point.xi) < 0;
    }
    sb_embedding_destroy(embedding);
    return result;
}

static sb_result regi_pieces_drop_lost(const regi_pieces *pieces, const sb_mesh *mesh, const int *cells,
                                       sb_boundary *skin, sb_error *error)
{
    unsigned char *lost =
        (unsigned char *)sbi_alloc_zeroed(&pieces->allocator, (size_t)skin->surface.node_count, sizeof *lost);
    sb_result result = lost ? regi_pieces_mark(pieces, mesh, cells, &skin->surface, lost, error)
                            : sbi_fail(error, SB_ERROR_MEMORY, "no memory for the skin of a body");
    if (result == SB_OK)
        regi_pieces_drop_faces(lost, skin);
    sbi_free(&pieces->allocator, lost);
    return result;
}

/* The boundary of the mesh before it was cut; its nodes are the body's. */
static sb_result regi_pieces_first_skin(const regi_pieces *pieces, sb_boundary *skin, sb_error *error)
{
    sb_mesh first;
    int *cells = NULL;
    sb_result result = sbi_body_copy_uncut(pieces->body, pieces->body, &pieces->allocator, &first, &cells, error);
    if (result != SB_OK)
        return result;
    result = sb_mesh_boundary(&first, 1, &pieces->allocator, skin, error);
    if (result == SB_OK && (result = regi_pieces_drop_lost(pieces, &first, cells, skin, error)) != SB_OK)
        sb_boundary_free(skin);
    sbi_free(&pieces->allocator, cells);
    sb_mesh_free(&first);
    return result;
}

REGI_API sb_result regi_pieces_skin(const regi_pieces *pieces, const sb_mesh *surface, sb_boundary *skin,
                                    sb_error *error)
{
    sb_result result;
    memset(skin, 0, sizeof *skin);
    if (!surface)
        return pieces->cells && sbi_body_has_uncut(pieces->body)
                   ? regi_pieces_first_skin(pieces, skin, error)
                   : sb_mesh_boundary(pieces->mesh, 1, &pieces->allocator, skin, error);
    result = sb_mesh_copy(surface, &pieces->allocator, &skin->surface, error);
    if (result == SB_OK && pieces->cells &&
        (result = regi_pieces_drop_lost(pieces, pieces->mesh, pieces->cells, skin, error)) != SB_OK)
        sb_boundary_free(skin);
    return result;
}

/* ==== src/register/match_private.h ==== */
/* match_private: what is inside a reg_match. Floor 6, internal: match.c makes it, match_step.c moves it. */
#ifndef REG_MATCH_PRIVATE_H
#define REG_MATCH_PRIVATE_H


/* Charges per task of the look at the target: fixed, whatever the threads. */
enum { REGI_MATCH_CHUNK = 128 };

/* A charge, or a landmark: a point of an element. Its weights and their gradients at rest are in rows of their own. */
typedef struct regi_match_charge {
    int element;
    int index;      /* triangle, vertex or landmark it is */
    sb_real area;   /* m^2 at rest */
    sb_vec3 normal; /* outward at rest */
    /* of the last look */
    int guess; /* item of the field that was closest, or -1 */
    int active;
    sb_vec3 point;     /* m */
    sb_vec3 force;     /* slope of the potential: of unit charge, away from the target */
    sb_vec3 line;      /* unit vector along which it is stiff */
    sb_real stiffness; /* along it (1/m), >= 0 */
    sb_real distance;  /* m */
    sb_real energy;    /* potential (m) */
} regi_match_charge;

struct reg_match {
    sb_allocator allocator;
    sb_clock clock;
    sb_body *body;
    sb_mesh mesh;             /* the body's at rest: a copy without free cells */
    int mesh_version;         /* of the body's mesh that all of this is about */
    const sb_vec3 *shape;     /* [nodes] displacements at which charges are looked at: the body's, borrowed */
    sbi_potential *potential; /* rows of charges and landmarks */
    double electric;          /* energy of the last look (J) */
    reg_field *field;
    reg_match_method method;
    int partial;
    sb_real size;                    /* of the organ (m) */
    sb_real young;                   /* Pa */
    sb_real rounding;                /* half of the sampling length (m) */
    sb_real first_reach, last_reach; /* m */
    sb_real least_cosine, least_active;
    sb_real first_charge, last_charge, least_growth, most_growth, settled;
    sb_real landmark_stiffness; /* N/m */
    double max_seconds;

    void *memory;                            /* the one block behind the arrays */
    int charge_count, landmark_count, width; /* width: nodes per element */
    regi_match_charge *charges;              /* [charge_count + landmark_count], each kind by element */
    sb_real *weights;                        /* [charges and landmarks][width] */
    sb_vec3 *gradients;                      /* [charges][width] of the weights, at rest (1/m) */
    sb_vec3 *targets;                        /* [landmark_count], in the order of the def */
    sb_vec3 *trial;                          /* [nodes] */
    sb_vec3 *last;                           /* [nodes] increment that the last step at full charge solved for (m) */
    double total_area;
    sb_real volume; /* of the organ at rest (m^3) */

    /* state */
    sb_real charge, reach; /* Young's moduli; m */
    sb_real last_mean;     /* m */
    sb_real relaxation;    /* share of the increment that the last step took; 0: that was not at full charge */
    int calm;              /* steps running that the mean distance did not fall */
    reg_match_info info;
};

/* Where a charge or landmark is now (m). */
REGI_API sb_vec3 regi_match_point(const reg_match *match, int charge);
/* Looks at the target: fills the charges' last look and the distances of the info. Returns the electric energy (J). */
REGI_API double regi_match_look(reg_match *match);
/* sbi_potential_fill of a match: looks, and fills the rows of charges and landmarks. */
REGI_API void regi_match_fill(void *user, const sb_vec3 *u, sb_vec3 *force, sb_real *stiffness, sb_vec3 *lines);
/* trial = the body's shape and the increment[nodes], shortened so that no node moves more than a tenth of the organ's
 * size and until the material admits the shape. On failure match->info.error says why. */
REGI_API sb_result regi_match_shorten(reg_match *match, const sb_vec3 *increment);
/* The nodes of the element that holds a charge or landmark. */
REGI_API const int *regi_match_nodes(const reg_match *match, int charge);

#endif /* REG_MATCH_PRIVATE_H */

/* ==== src/register/match.c ==== */
/* match: what a match is made from, and its charges. */

#include <string.h>


#define REGI_MATCH_COOKIE 0x6d617463u

enum { REGI_MATCH_TRIANGLES = 4000 }; /* finer surfaces carry their charges at the vertices, which are half as many */

REG_API reg_match_def reg_default_match_def(void)
{
    reg_match_def def;
    memset(&def, 0, sizeof def);
    def.method = REG_PBSM;
    def.cells = 64;
    def.partial = SB_AUTO;
    def.reach = (sb_real)0.1;
    def.last_reach = (sb_real)0.02;
    def.least_cosine = (sb_real)0.5;
    def.least_active = (sb_real)0.1;
    def.sampling = (sb_real)0.015;
    def.first_charge = (sb_real)0.2;
    def.last_charge = 100;
    def.least_growth = (sb_real)1.15;
    def.most_growth = 2;
    def.landmark_stiffness = 50;
    def.settled = (sb_real)0.005;
    def.max_seconds = 1e9;
    def.cookie = REGI_MATCH_COOKIE;
    return def;
}

/* ---- checks ---- */

static sb_result regi_match_check_numbers(const reg_match_def *def, sb_error *error)
{
    const struct {
        const char *name;
        sb_real value, low, high;
    } fields[] = {{"reach", def->reach, 0, SB_REAL_MAX},
                  {"last_reach", def->last_reach, 0, SB_REAL_MAX},
                  {"least_cosine", def->least_cosine, -1, 1},
                  {"least_active", def->least_active, 0, 1},
                  {"sampling", def->sampling, 0, SB_REAL_MAX},
                  {"first_charge", def->first_charge, 0, SB_REAL_MAX},
                  {"last_charge", def->last_charge, def->first_charge, SB_REAL_MAX},
                  {"least_growth", def->least_growth, 1, SB_REAL_MAX},
                  {"most_growth", def->most_growth, def->least_growth, SB_REAL_MAX},
                  {"landmark_stiffness", def->landmark_stiffness, 0, SB_REAL_MAX},
                  {"settled", def->settled, 0, SB_REAL_MAX}};
    for (size_t i = 0; i < sizeof fields / sizeof fields[0]; i++)
        if (!sb_is_finite(fields[i].value) || fields[i].value < fields[i].low || fields[i].value > fields[i].high)
            return sbi_fail(error, SB_ERROR_ARGUMENT, "%s of a match is %g, out of range", fields[i].name,
                            (double)fields[i].value);
    if (!(def->reach > 0 && def->last_reach > 0 && def->sampling > 0 && def->first_charge > 0 && def->settled > 0 &&
          def->landmark_stiffness > 0 && def->least_growth > 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "reaches, sampling, charges, settled and landmark_stiffness of a "
                        "match must be above 0, least_growth above 1");
    if (!(def->max_seconds > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_seconds is %g, not above 0", def->max_seconds);
    return SB_OK;
}

static sb_result regi_match_check_landmarks(const reg_match_def *def, sb_error *error)
{
    if (def->landmark_count < 0 || (def->landmark_count > 0 && (!def->landmarks || !def->landmark_targets)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d landmarks need points and targets", def->landmark_count);
    for (int i = 0; i < def->landmark_count; i++)
        if (!sb_v3_is_finite(def->landmarks[i]) || !sb_v3_is_finite(def->landmark_targets[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "landmark %d is not finite", i);
    return SB_OK;
}

static sb_result regi_match_check(const reg_match_def *def, sb_error *error)
{
    sb_result result;
    if (!def || def->cookie != REGI_MATCH_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a match needs a def made by reg_default_match_def");
    if (!def->body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a match needs a body");
    if ((def->target != NULL) == (def->target_points != NULL))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a match needs either a target or target_points");
    if (def->method != REG_PBSM && def->method != REG_PBSM_LAPLACE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "there is no method %d of matching", (int)def->method);
    if (def->partial != SB_AUTO && def->partial != 0 && def->partial != 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "partial is %d, not 0, 1 or SB_AUTO", def->partial);
    if (sbi_body_has_constraints(def->body))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "a body with constraints cannot be matched");
    if (sbi_body_mesh(def->body).element_type == SB_CUSTOM)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "a body of custom elements cannot be matched");
    result = regi_match_check_numbers(def, error);
    return result == SB_OK ? regi_match_check_landmarks(def, error) : result;
}

/* ---- where the charges sit ---- */

/* Points of a surface that carry its charges. */
typedef struct regi_match_sites {
    int count;
    sb_vec3 *points;
    sb_vec3 *areas; /* vectors (m^2) */
} regi_match_sites;

static void regi_match_free_sites(const sb_allocator *allocator, regi_match_sites *sites)
{
    sbi_free(allocator, sites->points);
    sbi_free(allocator, sites->areas);
}

static void regi_match_place_sites(const sb_mesh *triangles, int at_vertices, regi_match_sites *sites)
{
    const sb_real third = (sb_real)1 / 3;
    for (int t = 0; t < triangles->element_count; t++) {
        const int *c = triangles->elements + 3 * t;
        sb_vec3 a = triangles->nodes[c[0]], b = triangles->nodes[c[1]], d = triangles->nodes[c[2]];
        sb_vec3 area = sb_v3_scale((sb_real)0.5, sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(d, a)));
        if (!at_vertices) {
            sites->points[t] = sb_v3_scale(third, sb_v3_add(a, sb_v3_add(b, d)));
            sites->areas[t] = area;
        }
        for (int k = 0; k < 3 && at_vertices; k++) {
            sites->points[c[k]] = triangles->nodes[c[k]];
            sites->areas[c[k]] = sb_v3_madd(sites->areas[c[k]], third, area);
        }
    }
}

/* Those without area (unused vertices, flat triangles) carry nothing. */
static void regi_match_drop_sites(regi_match_sites *sites)
{
    int kept = 0;
    for (int i = 0; i < sites->count; i++)
        if (sb_v3_norm(sites->areas[i]) > 0) {
            sites->points[kept] = sites->points[i];
            sites->areas[kept++] = sites->areas[i];
        }
    sites->count = kept;
}

static sb_result regi_match_make_sites(const sb_mesh *surface, const sb_allocator *allocator, regi_match_sites *sites,
                                       sb_error *error)
{
    sb_mesh triangles;
    int at_vertices;
    sb_result result = sb_surface_triangulate(surface, allocator, &triangles, error);
    if (result != SB_OK)
        return result;
    at_vertices = triangles.element_count > REGI_MATCH_TRIANGLES;
    sites->count = at_vertices ? triangles.node_count : triangles.element_count;
    sites->points = (sb_vec3 *)sbi_alloc_zeroed(allocator, (size_t)sites->count, sizeof(sb_vec3));
    sites->areas = (sb_vec3 *)sbi_alloc_zeroed(allocator, (size_t)sites->count, sizeof(sb_vec3));
    if (sites->points && sites->areas) {
        regi_match_place_sites(&triangles, at_vertices, sites);
        regi_match_drop_sites(sites);
        if (sites->count == 0)
            result = sbi_fail(error, SB_ERROR_MESH, "the organ's surface has no area");
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d charges", sites->count);
    }
    sb_mesh_free(&triangles);
    return result;
}

/* Charges of the def's surface, or of the boundary of the body's mesh. */
static sb_result regi_match_find_sites(const regi_pieces *pieces, const reg_match_def *def, regi_match_sites *sites,
                                       sb_error *error)
{
    sb_boundary skin;
    sb_result result = regi_pieces_skin(pieces, def->surface, &skin, error);
    memset(sites, 0, sizeof *sites);
    if (result != SB_OK)
        return result;
    result = regi_match_make_sites(&skin.surface, &def->allocator, sites, error);
    sb_boundary_free(&skin);
    if (result != SB_OK)
        regi_match_free_sites(&def->allocator, sites);
    return result;
}

/* ---- points held by elements ---- */

/* Weights of the nodes, and unless NULL their gradients at rest, of an embedded point. Outside the mesh both are those
 * of the nearest point of the element, carried on linearly: exact for affine motions. */
static void regi_match_weigh(const sb_mesh *mesh, const sb_embedded_point *point, sb_real *weights, sb_vec3 *gradients)
{
    sb_real slope[SB_MAX_ELEMENT_NODES][3];
    sb_mat3 jacobian = sb_m3_zero(), inverse;
    int width = sb_mesh_element_width(mesh);
    const int *nodes = mesh->elements + (size_t)point->element * (size_t)width;
    sb_element_shape(mesh->element_type, point->xi, weights, slope);
    for (int a = 0; a < width; a++) {
        sb_vec3 s = sb_v3(slope[a][0], slope[a][1], slope[a][2]);
        weights[a] += s.x * point->step[0] + s.y * point->step[1] + s.z * point->step[2];
        jacobian = sb_m3_add(jacobian, sb_m3_outer(mesh->nodes[nodes[a]], s));
    }
    inverse = sb_m3_transpose(sb_m3_inverse(jacobian));
    for (int a = 0; a < width && gradients; a++)
        gradients[a] = sb_m3_apply(inverse, sb_v3(slope[a][0], slope[a][1], slope[a][2]));
}

static sb_result regi_match_embed(const sb_mesh *mesh, const sb_vec3 *points, int count, const reg_match_def *def,
                                  sb_real size, sb_embedding **embedding, sb_error *error)
{
    sb_embedding_def embed = sb_default_embedding_def();
    embed.mesh = mesh;
    embed.points = points;
    embed.point_count = count;
    embed.kind = SB_EMBED_PLAIN;
    embed.max_distance = (sb_real)0.25 * size; /* beyond, the surface and the model are not of one organ */
    embed.allocator = def->allocator;
    embed.jobs = *sbi_body_jobs(def->body);
    return sb_embedding_create(&embed, embedding, error);
}

/* Fills charges[count] and their rows, by ascending element. start: scratch [elements + 1], zeroed. */
static void regi_match_settle_points(const sb_embedding *embedding, const regi_pieces *pieces, int count, int *start,
                                     regi_match_charge *charges, sb_real *weights, sb_vec3 *gradients)
{
    const sb_mesh *mesh = pieces->mesh;
    size_t width = (size_t)sb_mesh_element_width(mesh);
    sb_embedded_point point;
    for (int i = 0; i < count; i++) {
        (void)sb_embedding_get_point(embedding, i, &point);
        start[regi_pieces_find(pieces, point.element, point.xi) + 1]++;
    }
    for (int e = 0; e < mesh->element_count; e++)
        start[e + 1] += start[e];
    for (int i = 0; i < count; i++) {
        size_t at;
        (void)sb_embedding_get_point(embedding, i, &point);
        point.element = regi_pieces_find(pieces, point.element, point.xi);
        at = (size_t)start[point.element]++;
        charges[at].element = point.element;
        charges[at].index = i;
        charges[at].guess = -1;
        regi_match_weigh(mesh, &point, weights + at * width, gradients ? gradients + at * width : NULL);
    }
}

/* ---- memory ---- */

static void regi_match_layout(reg_match *match, sbi_arena *arena)
{
    size_t charges = (size_t)match->charge_count, all = charges + (size_t)match->landmark_count;
    size_t width = (size_t)match->width, nodes = (size_t)match->mesh.node_count;
    match->charges = (regi_match_charge *)sbi_arena_take(arena, all, sizeof(regi_match_charge));
    match->weights = (sb_real *)sbi_arena_take(arena, all, width * sizeof(sb_real));
    match->gradients = (sb_vec3 *)sbi_arena_take(arena, charges, width * sizeof(sb_vec3));
    match->targets = (sb_vec3 *)sbi_arena_take(arena, (size_t)match->landmark_count, sizeof(sb_vec3));
    match->trial = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    match->last = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
}

static sb_result regi_match_allocate(reg_match *match, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    regi_match_layout(match, &arena);
    match->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&match->allocator, arena.used, 1);
    if (!match->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a match of %d charges", match->charge_count);
    arena.base = (unsigned char *)match->memory;
    arena.used = 0;
    regi_match_layout(match, &arena);
    return SB_OK;
}

/* Charges and landmarks in the elements that hold them. */
static sb_result regi_match_hold(reg_match *match, const reg_match_def *def, const regi_pieces *pieces,
                                 const regi_match_sites *sites, sb_error *error)
{
    sb_mesh mesh = match->mesh;
    size_t charges = (size_t)match->charge_count;
    for (int kind = 0; kind < 2; kind++) {
        const sb_vec3 *points = kind == 0 ? sites->points : def->landmarks;
        int count = kind == 0 ? match->charge_count : match->landmark_count;
        size_t first = kind == 0 ? 0 : charges;
        sb_embedding *embedding = NULL;
        int *start;
        sb_result result;
        if (count == 0)
            continue;
        result = regi_match_embed(&mesh, points, count, def, match->size, &embedding, error);
        if (result != SB_OK)
            return result;
        start = (int *)sbi_alloc_zeroed(&match->allocator, (size_t)mesh.element_count + 1, sizeof(int));
        if (start)
            regi_match_settle_points(embedding, pieces, count, start, match->charges + first,
                                     match->weights + first * (size_t)match->width,
                                     kind == 0 ? match->gradients : NULL);
        sb_embedding_destroy(embedding);
        sbi_free(&match->allocator, start);
        if (!start)
            return sbi_fail(error, SB_ERROR_MEMORY, "no memory to sort %d points", count);
    }
    for (size_t i = 0; i < charges; i++) {
        regi_match_charge *charge = match->charges + i;
        sb_vec3 area = sites->areas[charge->index];
        charge->area = sb_v3_norm(area);
        charge->normal = sb_v3_scale((sb_real)1 / charge->area, area);
        match->total_area += (double)charge->area;
    }
    return SB_OK;
}

/* ---- life ---- */

static sb_result regi_match_make_field(reg_match *match, const reg_match_def *def, sb_error *error)
{
    reg_field_def field = reg_default_field_def();
    sb_mesh mesh = match->mesh;
    field.kind = def->method == REG_PBSM_LAPLACE ? REG_FIELD_LAPLACE : REG_FIELD_DISTANCE;
    field.surface = def->target;
    field.points = def->target_points;
    field.normals = def->target_normals;
    field.point_count = def->target_count;
    field.cells = def->cells;
    field.allocator = def->allocator;
    field.jobs = *sbi_body_jobs(match->body);
    sb_mesh_bounds(&mesh, &field.low, &field.high);
    return reg_field_create(&field, &match->field, error);
}

static sb_result regi_match_set(reg_match *match, const reg_match_def *def, sb_error *error)
{
    sb_mesh mesh;
    sb_vec3 low, high;
    sb_real share; /* of an element in the cube of the organ's size: its cube root is the element's size */
    sb_result result = sbi_body_copy_mesh(def->body, &def->allocator, &match->mesh, error);
    if (result != SB_OK)
        return result;
    mesh = match->mesh;
    sb_mesh_bounds(&mesh, &low, &high);
    match->body = def->body;
    match->mesh_version = sb_body_mesh_version(def->body);
    match->shape = sb_body_displacements(def->body);
    match->clock = def->clock;
    match->method = def->method;
    match->width = sb_mesh_element_width(&mesh);
    match->size = sb_v3_norm(sb_v3_sub(high, low));
    match->young = sbi_body_young(def->body); /* what charges are measured with */
    if (!sb_is_finite(match->young) || !(match->young > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL, "the body's Young's modulus is %g", (double)match->young);
    match->rounding = (sb_real)0.5 * def->sampling * match->size;
    match->first_reach = def->reach * match->size;
    match->last_reach = sb_min(def->last_reach, def->reach) * match->size;
    match->least_cosine = def->least_cosine;
    match->least_active = def->least_active;
    match->first_charge = def->first_charge;
    match->last_charge = def->last_charge;
    match->least_growth = def->least_growth;
    match->most_growth = def->most_growth;
    match->settled = def->settled;
    match->max_seconds = def->max_seconds;
    match->landmark_count = def->landmark_count;
    match->volume = sb_mesh_volume(&mesh);
    share = match->volume / ((sb_real)mesh.element_count * match->size * match->size * match->size);
    match->landmark_stiffness = def->landmark_stiffness * match->young * match->size * sb_exp(sb_log(share) / 3);
    return SB_OK;
}

/* Rows of charges and landmarks, for the body's solver. */
static sb_result regi_match_make_potential(reg_match *match, sb_error *error)
{
    size_t rows = (size_t)match->charge_count + (size_t)match->landmark_count, width = (size_t)match->width;
    int *start, *nodes;
    sb_mapping mapping;
    sb_result result = SB_OK;
    if (rows * width > INT32_MAX)
        return sbi_fail(error, SB_ERROR_MEMORY, "%d charges have too many nodes", match->charge_count);
    start = (int *)sbi_alloc(&match->allocator, rows + 1, sizeof(int));
    nodes = (int *)sbi_alloc(&match->allocator, rows * width, sizeof(int));
    if (!start || !nodes)
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d charges", match->charge_count);
    for (size_t i = 0; i <= rows && result == SB_OK; i++)
        start[i] = (int)(i * width);
    for (size_t i = 0; i < rows && result == SB_OK; i++)
        memcpy(nodes + i * width, regi_match_nodes(match, (int)i), width * sizeof(int));
    mapping.row_count = (int)rows;
    mapping.row_start = start;
    mapping.nodes = nodes;
    mapping.weights = match->weights;
    if (result == SB_OK)
        result = sbi_potential_create(match->body, &mapping, regi_match_fill, match, &match->allocator,
                                      &match->potential, error);
    sbi_free(&match->allocator, start);
    sbi_free(&match->allocator, nodes);
    return result;
}

/* The charges, and the rows of all that is held. */
static sb_result regi_match_build_on(reg_match *match, const reg_match_def *def, const regi_pieces *pieces,
                                     sb_error *error)
{
    regi_match_sites sites;
    sb_result result = regi_match_find_sites(pieces, def, &sites, error);
    if (result != SB_OK)
        return result;
    match->charge_count = sites.count;
    result = regi_match_allocate(match, error);
    if (result == SB_OK)
        result = regi_match_hold(match, def, pieces, &sites, error);
    regi_match_free_sites(&def->allocator, &sites);
    return result == SB_OK ? regi_match_make_potential(match, error) : result;
}

static sb_result regi_match_build(reg_match *match, const reg_match_def *def, sb_error *error)
{
    regi_pieces pieces;
    sb_result result = regi_match_set(match, def, error);
    if (result == SB_OK)
        result = regi_match_make_field(match, def, error);
    if (result != SB_OK)
        return result;
    match->partial = def->partial == SB_AUTO ? regi_field_is_open(match->field) : def->partial;
    result = regi_pieces_make(def->body, &match->mesh, &def->allocator, &pieces, error);
    if (result == SB_OK)
        result = regi_match_build_on(match, def, &pieces, error);
    regi_pieces_free(&pieces);
    if (result == SB_OK && match->landmark_count)
        memcpy(match->targets, def->landmark_targets, (size_t)match->landmark_count * sizeof(sb_vec3));
    return result;
}

REG_API sb_result reg_match_create(const reg_match_def *def, reg_match **match, sb_error *error)
{
    reg_match *made;
    sb_result result = regi_match_check(def, error);
    if (result == SB_OK && !match)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "there is no place for the match");
    if (result != SB_OK)
        return result;
    made = (reg_match *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a match");
    made->allocator = def->allocator;
    result = regi_match_build(made, def, error);
    if (result != SB_OK) {
        reg_match_destroy(made);
        return result;
    }
    reg_match_restart(made);
    *match = made;
    return SB_OK;
}

REG_API void reg_match_destroy(reg_match *match)
{
    sb_allocator allocator;
    if (!match)
        return;
    allocator = match->allocator;
    reg_field_destroy(match->field);
    sbi_potential_destroy(match->potential);
    sb_mesh_free(&match->mesh);
    sbi_free(&allocator, match->memory);
    sbi_free(&allocator, match);
}

REG_API void reg_match_restart(reg_match *match)
{
    double seconds;
    if (!match)
        return;
    seconds = match->info.seconds;
    memset(&match->info, 0, sizeof match->info);
    match->info.seconds = seconds;
    match->info.charge = match->first_charge;
    match->info.error.line = 0;
    match->info.error.element = match->info.error.node = -1;
    match->charge = match->first_charge;
    match->reach = match->first_reach;
    match->last_mean = SB_REAL_MAX;
    match->relaxation = 0;
    match->calm = 0;
}

/* ---- landmarks and readings ---- */

REG_API sb_result reg_match_move_landmarks(reg_match *match, const sb_vec3 *targets)
{
    if (!match || (!targets && match->landmark_count))
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < match->landmark_count; i++)
        if (!sb_v3_is_finite(targets[i]))
            return SB_ERROR_NOT_FINITE;
    if (match->landmark_count)
        memcpy(match->targets, targets, (size_t)match->landmark_count * sizeof(sb_vec3));
    match->last_mean = SB_REAL_MAX;
    match->relaxation = 0;
    match->calm = 0;
    match->info.stop = REG_MATCH_RUNNING;
    return SB_OK;
}

REG_API void reg_match_landmarks(const reg_match *match, sb_vec3 *points)
{
    if (!match || !points || sbi_body_check_version(match->body, match->mesh_version, NULL) != SB_OK)
        return;
    for (int i = match->charge_count; i < match->charge_count + match->landmark_count; i++)
        points[match->charges[i].index] = regi_match_point(match, i);
}

REG_API const sb_body *reg_match_body(const reg_match *match) { return match ? match->body : NULL; }

REG_API reg_match_info reg_match_get_info(const reg_match *match)
{
    reg_match_info none;
    if (!match) {
        memset(&none, 0, sizeof none);
        return none;
    }
    return match->info;
}

REG_API int reg_match_sample_count(const reg_match *match) { return match ? match->charge_count : 0; }

REG_API sb_result reg_match_get_sample(const reg_match *match, int index, reg_match_sample *sample)
{
    const regi_match_charge *charge;
    if (!match || !sample)
        return SB_ERROR_ARGUMENT;
    if (index < 0 || index >= match->charge_count)
        return SB_ERROR_INDEX;
    charge = match->charges + index;
    sample->point = charge->point;
    sample->area = charge->area;
    sample->distance = charge->distance;
    sample->active = charge->active;
    return SB_OK;
}

/* ==== src/register/match_step.c ==== */
/* match_step: one step of a match: look at the target, pull, solve, raise the charge. */
#include <string.h>


static double regi_match_now(const reg_match *match) { return match->clock ? match->clock() : 0.0; }

REGI_API const int *regi_match_nodes(const reg_match *match, int charge)
{
    return match->mesh.elements + (size_t)match->charges[charge].element * (size_t)match->width;
}

REGI_API sb_vec3 regi_match_point(const reg_match *match, int charge)
{
    const int *nodes = regi_match_nodes(match, charge);
    const sb_real *weights = match->weights + (size_t)charge * (size_t)match->width;
    sb_vec3 x = sb_v3(0, 0, 0);
    for (int a = 0; a < match->width; a++)
        x = sb_v3_madd(x, weights[a], sb_v3_add(match->mesh.nodes[nodes[a]], match->shape[nodes[a]]));
    return x;
}

/* ---- looking at the target ---- */

/* The outward normal now: cof(F) N. Where the element is flat, the one at rest. */
static sb_vec3 regi_match_normal(const reg_match *match, int charge)
{
    const int *nodes = regi_match_nodes(match, charge);
    const sb_vec3 *gradients = match->gradients + (size_t)charge * (size_t)match->width;
    sb_vec3 rest = match->charges[charge].normal, r[3], normal;
    sb_mat3 f = sb_m3_zero();
    sb_real length;
    for (int a = 0; a < match->width; a++)
        f = sb_m3_add(f, sb_m3_outer(sb_v3_add(match->mesh.nodes[nodes[a]], match->shape[nodes[a]]), gradients[a]));
    for (int c = 0; c < 3; c++)
        r[c] = sb_v3(f.m[0][c], f.m[1][c], f.m[2][c]);
    normal = sb_v3_scale(rest.x, sb_v3_cross(r[1], r[2]));
    normal = sb_v3_madd(normal, rest.y, sb_v3_cross(r[2], r[0]));
    normal = sb_v3_madd(normal, rest.z, sb_v3_cross(r[0], r[1]));
    length = sb_v3_norm(normal);
    return length > 0 ? sb_v3_scale((sb_real)1 / length, normal) : rest;
}

/* Distance potential, rounded off within r of the target: phi' = d/r there and 1 beyond, along the normal of the target
 * (of the organ, when the target's is not known). Beyond, its own second derivative is 0; 1/d in its place is the
 * curvature of the parabola that touches it from above, so that a step never goes too far. */
static void regi_match_feel_distance(const reg_match *match, regi_match_charge *charge, const reg_field_hit *hit,
                                     sb_vec3 normal)
{
    sb_real r = match->rounding, d, size;
    charge->line = sb_v3_dot(hit->normal, hit->normal) > 0 ? hit->normal : normal;
    d = sb_v3_dot(sb_v3_sub(charge->point, hit->point), charge->line);
    size = sb_abs(d);
    charge->stiffness = 1 / sb_max(r, size);
    charge->force = sb_v3_scale(d * charge->stiffness, charge->line);
    charge->energy = size < r ? (sb_real)0.5 * d * d / r : size - (sb_real)0.5 * r;
}

/* Laplace's: the slope along the organ's normal. What the grid's gradient has across it is noise of the cells, against
 * which nothing would hold the charge. */
static int regi_match_feel_grid(const reg_match *match, regi_match_charge *charge, sb_vec3 normal)
{
    reg_field_sample sample;
    if (!reg_field_along(match->field, charge->point, normal, 2 * match->rounding, -1, &sample))
        return 0;
    charge->line = normal;
    charge->energy = sample.phi;
    charge->force = sb_v3_scale(sample.phi_n, normal);
    charge->stiffness = sb_max(sample.phi_nn, sb_abs(sample.phi_n) / sb_max(match->rounding, charge->distance));
    return 1;
}

static void regi_match_look_at(reg_match *match, int index)
{
    regi_match_charge *charge = match->charges + index;
    sb_vec3 normal = regi_match_normal(match, index);
    reg_field_hit hit;
    charge->point = regi_match_point(match, index);
    charge->active = reg_field_closest(match->field, charge->point, charge->guess, &hit);
    if (!charge->active)
        return;
    charge->guess = hit.item;
    charge->distance = hit.distance;
    if (match->partial) {
        int known = sb_v3_dot(hit.normal, hit.normal) > 0;
        charge->active = !hit.on_border && hit.distance < match->reach &&
                         (!known || sb_v3_dot(normal, hit.normal) > match->least_cosine);
    }
    if (!charge->active)
        return;
    if (match->method == REG_PBSM_LAPLACE)
        charge->active = regi_match_feel_grid(match, charge, normal);
    else
        regi_match_feel_distance(match, charge, &hit, normal);
}

static void regi_match_look_chunk(void *user, int chunk)
{
    reg_match *match = (reg_match *)user;
    int first = chunk * REGI_MATCH_CHUNK, last = sbi_min_int(first + REGI_MATCH_CHUNK, match->charge_count);
    for (int i = first; i < last; i++)
        regi_match_look_at(match, i);
}

/* Sums over the charges, in their order. Returns the electric energy (J). */
REGI_API double regi_match_look(reg_match *match)
{
    double area = 0, mean = 0, energy = 0;
    sb_real most = 0;
    int chunks = (match->charge_count + REGI_MATCH_CHUNK - 1) / REGI_MATCH_CHUNK;
    sbi_run(sbi_body_jobs(match->body), regi_match_look_chunk, match, chunks);
    for (int i = 0; i < match->charge_count; i++) {
        const regi_match_charge *charge = match->charges + i;
        if (!charge->active)
            continue;
        area += (double)charge->area;
        mean += (double)charge->area * (double)charge->distance;
        energy += (double)charge->area * (double)charge->energy;
        most = sb_max(most, charge->distance);
    }
    match->info.active = (sb_real)(area / match->total_area);
    match->info.mean_distance = area > 0 ? (sb_real)(mean / area) : 0;
    match->info.max_distance = most;
    return energy * (double)match->charge * (double)match->young;
}

/* ---- the system ---- */

/* Charges pull against the slope of the potential, landmarks are springs to where they are seen: sbi_potential_fill. */
REGI_API void regi_match_fill(void *user, const sb_vec3 *u, sb_vec3 *force, sb_real *stiffness, sb_vec3 *lines)
{
    reg_match *match = (reg_match *)user;
    double begin = regi_match_now(match);
    sb_real q = match->charge * match->young;
    match->shape = u;
    match->electric = regi_match_look(match);
    match->info.landmark_distance = 0;
    for (int i = 0; i < match->charge_count; i++) {
        const regi_match_charge *charge = match->charges + i;
        sb_real weight = charge->active ? q * charge->area : 0;
        force[i] = charge->active ? sb_v3_scale(-weight, charge->force) : sb_v3(0, 0, 0);
        stiffness[i] = charge->active ? weight * charge->stiffness : 0;
        lines[i] = charge->active ? charge->line : sb_v3(0, 0, 0);
    }
    for (int i = match->charge_count; i < match->charge_count + match->landmark_count; i++) {
        sb_vec3 gap = sb_v3_sub(match->targets[match->charges[i].index], regi_match_point(match, i));
        force[i] = sb_v3_scale(match->landmark_stiffness, gap);
        stiffness[i] = match->landmark_stiffness;
        lines[i] = sb_v3(0, 0, 0);
        match->info.landmark_distance = sb_max(match->info.landmark_distance, sb_v3_norm(gap));
    }
    match->shape = sb_body_displacements(match->body);
    match->info.seconds_field = regi_match_now(match) - begin;
}

/* ---- moving ---- */

/* Length of the longest increment; not finite when one is not. */
static sb_real regi_match_largest(const sb_vec3 *increment, int count)
{
    sb_real most = 0;
    for (int i = 0; i < count; i++) {
        sb_real length = sb_v3_norm(increment[i]);
        if (!sb_is_finite(length))
            return length;
        most = sb_max(most, length);
    }
    return most;
}

REGI_API sb_result regi_match_shorten(reg_match *match, const sb_vec3 *increment)
{
    const sb_vec3 *shape = sb_body_displacements(match->body);
    int n = match->mesh.node_count, bad = 0;
    sb_real largest = regi_match_largest(increment, n), limit = (sb_real)0.1 * match->size, share, energy;
    if (!sb_is_finite(largest))
        return sbi_fail(&match->info.error, SB_ERROR_DIVERGED, "the step of a match is not finite");
    share = largest > limit ? limit / largest : 1;
    for (int cut = 0; cut < 20; cut++, share *= (sb_real)0.5) {
        for (int i = 0; i < n; i++)
            match->trial[i] = sb_v3_madd(shape[i], share, increment[i]);
        bad = sbi_body_try_shape(match->body, match->trial, &energy);
        if (bad < 0 && sb_is_finite(energy)) {
            match->info.change = share * largest;
            return SB_OK;
        }
    }
    return sbi_fail_element(&match->info.error, SB_ERROR_INVERTED, bad,
                            "element %d would turn inside out however short the step", bad);
}

/* ---- control ---- */

/* 1 when neither charge nor reach changes any more. */
static int regi_match_is_full(const reg_match *match)
{
    return match->charge >= match->last_charge && (!match->partial || match->reach <= match->last_reach);
}

/* Along the surface only the body holds a charge, and where that rests on an edge between two facets of the target each
 * step turns it over to the other one: at full charge places would swing to and fro for ever. Aitken's relaxation takes
 * the share of the increment at which the last two cancel out; all of it where they grow, since then something moved.
 * Supports go where they are to be in any case. */
static void regi_match_relax(reg_match *match, sb_vec3 *increment)
{
    const sb_real least = (sb_real)0.1;
    const unsigned char *fixed = sb_body_supports(match->body);
    double fall = 0, square = 0;
    sb_real share = 1;
    for (int i = 0; i < match->mesh.node_count && match->relaxation > 0; i++) {
        sb_vec3 less = sb_v3_sub(match->last[i], increment[i]);
        fall += (double)sb_v3_dot(match->last[i], less);
        square += (double)sb_v3_dot(less, less);
    }
    if (fall > 0)
        share = sb_max(least, sb_min(match->relaxation * (sb_real)(fall / square), 1));
    for (int i = 0; i < match->mesh.node_count; i++) {
        match->last[i] = increment[i];
        increment[i] = sbi_body_pick_axes(fixed[i], increment[i], sb_v3_scale(share, increment[i]));
    }
    match->relaxation = share;
}

/* q <- q clamp(I_int / I_phi), and a partial target's reach shrinks. */
static void regi_match_raise(reg_match *match, double elastic, double electric)
{
    sb_real ratio = electric > 0 ? (sb_real)(elastic / electric) : match->most_growth;
    ratio = sb_max(match->least_growth, sb_min(ratio, match->most_growth));
    match->charge = sb_min(match->charge * ratio, match->last_charge);
    match->reach = sb_max(match->last_reach, (sb_real)0.93 * match->reach);
}

/* Three steps running at full charge and reach without a fall of the mean distance worth the name. */
static void regi_match_judge(reg_match *match)
{
    sb_real mean = match->info.mean_distance;
    match->calm = regi_match_is_full(match) && mean >= (1 - match->settled) * match->last_mean ? match->calm + 1 : 0;
    if (!(mean >= match->last_mean))
        match->last_mean = mean;
    match->info.stop = match->calm >= 3 ? REG_MATCH_SETTLED : REG_MATCH_RUNNING;
}

/* Of a point, a flat patch or a target in another unit the charges make what no organ looks like. */
static sb_result regi_match_check_shape(reg_match *match)
{
    sb_mesh mesh = match->mesh;
    double share;
    mesh.nodes = sbi_body_shape(match->body).nodes;
    share = (double)(sb_mesh_volume(&mesh) / match->volume);
    if (share > 0.25 && share < 4)
        return SB_OK;
    return sbi_fail(&match->info.error, SB_ERROR_DIVERGED,
                    "the organ's volume has become %.3g times what it was: the "
                    "target shows a part of it only, or is of another size",
                    share);
}

/* What the look that came with the system says against going on. */
static sb_result regi_match_check_look(reg_match *match)
{
    if (match->partial && match->info.active < match->least_active && match->landmark_count == 0)
        return sbi_fail(&match->info.error, SB_ERROR_NOT_CONVERGED,
                        "only %.1f %% of the organ's surface is near the "
                        "target and faces as it does: align them first",
                        100 * (double)match->info.active);
    return regi_match_is_full(match) ? regi_match_check_shape(match) : SB_OK;
}

/* Solves for the increment and finds the shape it leads to, in match->trial. */
static sb_result regi_match_solve(reg_match *match, sbi_step *step)
{
    double begin = regi_match_now(match);
    sb_result result = sbi_step_solve(step);
    match->info.pcg_iterations = step->info->pcg_iterations;
    match->info.seconds_solve = regi_match_now(match) - begin;
    if (result != SB_OK)
        return sbi_fail(&match->info.error, result, "the system of a match could not be solved");
    if (regi_match_is_full(match))
        regi_match_relax(match, sbi_relax_increment(step));
    return regi_match_shorten(match, sbi_relax_increment(step));
}

/* Rigid motions that nothing holds would leave the matrix singular: the stiffness that holds them is far below what a
 * charge adds. The next step sees what the loose tolerance leaves. */
static sb_result regi_match_try(reg_match *match)
{
    sb_body *body = match->body;
    sb_step_info info;
    sbi_step step;
    double begin = regi_match_now(match);
    sb_real elastic = 0, held = (sb_real)1e-4 * match->young * match->size;
    sb_result assembled = sbi_relax_begin(body, match->potential, held, (sb_real)1e-2, &info, &step), result;
    match->info.seconds_system = regi_match_now(match) - begin - match->info.seconds_field;
    result = info.error.result == SB_ERROR_MEMORY ? SB_OK : regi_match_check_look(match);
    if (result == SB_OK && assembled != SB_OK) {
        match->info.error = info.error;
        result = assembled;
    }
    if (result == SB_OK)
        (void)sbi_body_try_shape(body, sb_body_displacements(body), &elastic);
    if (result == SB_OK)
        result = regi_match_solve(match, &step);
    sbi_relax_end(&step, match->potential, result == SB_OK ? match->trial : NULL);
    if (result != SB_OK)
        return result;
    match->info.charge = match->charge;
    regi_match_judge(match);
    regi_match_raise(match, (double)elastic, match->electric);
    match->info.iterations++;
    return SB_OK;
}

REG_API sb_result reg_match_step(reg_match *match, reg_match_info *info)
{
    sb_result result;
    double begin;
    if (!match)
        return SB_ERROR_ARGUMENT;
    begin = regi_match_now(match);
    memset(&match->info.error, 0, sizeof match->info.error);
    match->info.error.element = match->info.error.node = -1;
    result = sbi_body_check_version(match->body, match->mesh_version, &match->info.error);
    if (result == SB_OK && sbi_body_has_constraints(match->body))
        result = sbi_fail(&match->info.error, SB_ERROR_UNSUPPORTED, "the body has constraints now");
    if (result == SB_OK)
        result = regi_match_try(match);
    match->info.seconds += regi_match_now(match) - begin;
    if (result != SB_OK)
        match->info.stop = result == SB_ERROR_NOT_CONVERGED ? REG_MATCH_NO_OVERLAP : REG_MATCH_FAILED;
    if (info)
        *info = match->info;
    return result;
}

REG_API sb_result reg_match_run(reg_match *match, int steps, reg_match_info *info)
{
    sb_result result = SB_OK;
    if (!match || steps < 1)
        return SB_ERROR_ARGUMENT;
    match->info.stop = REG_MATCH_RUNNING;
    for (int i = 0; result == SB_OK && match->info.stop == REG_MATCH_RUNNING; i++) {
        if (i == steps)
            match->info.stop = REG_MATCH_STEP_CAP;
        else if (match->info.seconds >= match->max_seconds)
            match->info.stop = REG_MATCH_TIME_CAP;
        else
            result = reg_match_step(match, NULL);
    }
    if (info)
        *info = match->info;
    return result;
}

/* ==== src/register/nicp_private.h ==== */
/* nicp_private: what is inside a reg_nicp. Floor 6, internal: nicp.c makes it, nicp_step.c moves it. */
#ifndef REG_NICP_PRIVATE_H
#define REG_NICP_PRIVATE_H


/* Points per task of the look at the target: fixed, whatever the threads. */
enum { REGI_NICP_CHUNK = 128 };

/* A vertex of the organ's surface that stands for those around it. */
typedef struct regi_nicp_source {
    int vertex;
    int triangle, corner; /* a triangle that has it; -1: none has */
    sb_real area;         /* m^2 at rest */
    /* of the last look */
    int guess;    /* item of the field that was closest, or -1 */
    int way_back; /* triangle of the skin that was closest to it */
    int visible;
    int paired; /* N_s counts, up to its distance */
    int active;
    sb_vec3 normal;    /* unit, or 0 */
    sb_vec3 direction; /* across the target where it was hit, or across the organ; unit, or 0 */
    sb_vec3 way;       /* to N_s (m) */
    sb_vec3 sum;       /* of the ways to those in V (m) */
    int count;         /* of V */
    sb_real distance;  /* m */
} regi_nicp_source;

/* A point of the target that looks for its source. */
typedef struct regi_nicp_sample {
    sb_vec3 point;  /* m */
    sb_vec3 normal; /* unit, or 0: unknown */
    /* of the last look */
    int guess;   /* triangle of the skin */
    int source;  /* N_t, or -1 */
    sb_vec3 way; /* from the organ's surface to the point (m) */
} regi_nicp_sample;

/* Rows of node weights: the points of def.surface, or the landmarks. */
typedef struct regi_nicp_rows {
    sb_mapping mapping; /* of the arrays below */
    int *start, *nodes;
    sb_real *weights;
} regi_nicp_rows;

struct reg_nicp {
    sb_allocator allocator;
    sb_clock clock;
    sb_body *body;
    sb_mesh mesh;     /* the body's at rest: a copy without free cells */
    int mesh_version; /* of the body's mesh that all of this is about */
    reg_field *field;
    int is_cloud;                    /* the target is one */
    sb_real spacing;                 /* of the target's points (m) */
    sb_surface *skin;                /* the organ's surface as it is now */
    regi_nicp_rows rows;             /* [vertex_count] */
    regi_nicp_rows source_rows;      /* [source_count] */
    regi_nicp_rows landmark_rows;    /* [landmark_count] */
    int surface_load, landmark_load; /* ids of the penalties; 0: none */

    reg_nicp_view view;
    sb_vec3 camera;
    sb_real size;  /* of the organ (m) */
    sb_real young; /* Pa */
    sb_real blending, sliding, least_cosine, outlier_parameter, tolerance, newton_tolerance, least_active;
    reg_outliers outliers;
    sb_real reach, last_reach;               /* m */
    sb_real first_stiffness, last_stiffness; /* Pa/m */
    int increments, iterations, newton, noisy;
    sb_real landmark_stiffness; /* N/m */
    double max_seconds;

    int vertex_count, source_count, sample_count, landmark_count;
    double total_area;            /* m^2 */
    sb_real volume;               /* of the organ, or its grid, at rest (m^3) */
    void *memory;                 /* the one block behind the arrays below */
    sb_vec3 *vertices;            /* [vertex_count] (m) now */
    int *source_of;               /* [vertex_count] the source that stands for it; -1: none does */
    regi_nicp_source *sources;    /* [source_count] */
    regi_nicp_sample *samples;    /* [sample_count] */
    sb_real *distances, *scratch; /* [the larger of both counts] */
    sb_vec3 *goals;               /* [source_count] (m) */
    sb_real *stiffness;           /* [source_count] (N/m) */
    sb_vec3 *lines;               /* [source_count] see sbi_body_set_mapping_lines */
    sb_vec3 *before;              /* [source_count] (m) sources before the balance */
    sb_vec3 *settled;             /* [source_count] (m) sources at the end of the last increment */
    sb_vec3 *targets;             /* [landmark_count] (m) */

    /* state */
    int increment, iteration; /* from 0 */
    int has_settled;
    reg_nicp_info info;
};

/* Writes where rows are now: points[row_count] (m). */
REGI_API void regi_nicp_points(const reg_nicp *nicp, const regi_nicp_rows *rows, sb_vec3 *points);

#endif /* REG_NICP_PRIVATE_H */

/* ==== src/register/nicp.c ==== */
/* nicp: what a non-rigid registration is made from: sources, samples, and the rows that hold them. */

#include <string.h>


#define REGI_NICP_COOKIE 0x6e696370u

REG_API reg_nicp_def reg_default_nicp_def(void)
{
    reg_nicp_def def;
    memset(&def, 0, sizeof def);
    def.sources = 4000;
    def.samples = 2000;
    def.view = REG_NICP_ALL;
    def.blending = (sb_real)0.75;
    def.sliding = (sb_real)0.999;
    def.least_cosine = (sb_real)0.3;
    def.outliers = REG_OUTLIERS_MEDIAN;
    def.outlier_parameter = 3;
    def.reach = (sb_real)0.1;
    def.last_reach = (sb_real)0.03;
    def.first_stiffness = 300;
    def.last_stiffness = 30000;
    def.increments = 4;
    def.iterations = 2;
    def.newton = 6;
    def.newton_tolerance = (sb_real)0.07;
    def.tolerance = (sb_real)5e-5;
    def.least_active = (sb_real)0.05;
    def.landmark_stiffness = 50;
    def.max_seconds = 1e9;
    def.cookie = REGI_NICP_COOKIE;
    return def;
}

/* ---- checks ---- */

static sb_result regi_nicp_check_numbers(const reg_nicp_def *def, sb_error *error)
{
    const struct {
        const char *name;
        sb_real value, low, high;
        int above; /* 1: low itself is out of range, too */
    } fields[] = {{"blending", def->blending, 0, 1, 0},
                  {"sliding", def->sliding, 0, 1, 0},
                  {"least_cosine", def->least_cosine, -1, 1, 0},
                  {"reach", def->reach, 0, SB_REAL_MAX, 1},
                  {"last_reach", def->last_reach, 0, def->reach, 1},
                  {"first_stiffness", def->first_stiffness, 0, SB_REAL_MAX, 1},
                  {"last_stiffness", def->last_stiffness, def->first_stiffness, SB_REAL_MAX, 0},
                  {"newton_tolerance", def->newton_tolerance, 0, 1 - SB_EPSILON, 1},
                  {"tolerance", def->tolerance, 0, SB_REAL_MAX, 1},
                  {"least_active", def->least_active, 0, 1, 0},
                  {"landmark_stiffness", def->landmark_stiffness, 0, SB_REAL_MAX, 1},
                  {"sources", (sb_real)def->sources, 4, SB_REAL_MAX, 0},
                  {"samples", (sb_real)def->samples, 0, SB_REAL_MAX, 0},
                  {"increments", (sb_real)def->increments, 1, SB_REAL_MAX, 0},
                  {"iterations", (sb_real)def->iterations, 1, SB_REAL_MAX, 0},
                  {"newton", (sb_real)def->newton, 1, SB_REAL_MAX, 0}};
    for (size_t i = 0; i < sizeof fields / sizeof fields[0]; i++)
        if (!sb_is_finite(fields[i].value) || fields[i].value < fields[i].low || fields[i].value > fields[i].high ||
            (fields[i].above && !(fields[i].value > fields[i].low)))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "%s of a registration is %g, out of range", fields[i].name,
                            (double)fields[i].value);
    if (!(def->max_seconds > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_seconds is %g, not above 0", def->max_seconds);
    return SB_OK;
}

static sb_result regi_nicp_check_rules(const reg_nicp_def *def, sb_error *error)
{
    sb_real distances[2] = {1, 1}, scratch[2];
    if (def->view != REG_NICP_ALL && def->view != REG_NICP_FACING && def->view != REG_NICP_VISIBLE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "there is no view %d of the organ", (int)def->view);
    if (!sb_v3_is_finite(def->camera))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the camera's place is not finite");
    if (reg_outlier_limit(distances, 2, def->outliers, def->outlier_parameter, scratch) < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "there is no rule %d for outliers with the parameter %g",
                        (int)def->outliers, (double)def->outlier_parameter);
    return SB_OK;
}

static sb_result regi_nicp_check_landmarks(const reg_nicp_def *def, sb_error *error)
{
    if (def->landmark_count < 0 || (def->landmark_count > 0 && (!def->landmarks || !def->landmark_targets)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d landmarks need points and targets", def->landmark_count);
    for (int i = 0; i < def->landmark_count; i++)
        if (!sb_v3_is_finite(def->landmarks[i]) || !sb_v3_is_finite(def->landmark_targets[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "landmark %d is not finite", i);
    return SB_OK;
}

static sb_result regi_nicp_check(const reg_nicp_def *def, sb_error *error)
{
    sb_result result;
    if (!def || def->cookie != REGI_NICP_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a registration needs a def made by reg_default_nicp_def");
    if (!def->body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a registration needs a body");
    if ((def->target != NULL) == (def->target_points != NULL))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a registration needs either a target or target_points");
    if (sbi_body_mesh(def->body).element_type == SB_CUSTOM)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "a body of custom elements cannot be registered");
    if (def->grid && !def->surface)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a body in a grid needs its surface");
    if (def->grid &&
        (sb_body_mesh_version(def->body) != 0 || def->grid->body_mesh.node_count != sb_body_node_count(def->body) ||
         def->grid->body_mesh.element_count != sb_body_element_count(def->body)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the body was not made from the grid, or has changed since");
    result = regi_nicp_check_numbers(def, error);
    if (result == SB_OK)
        result = regi_nicp_check_rules(def, error);
    return result == SB_OK ? regi_nicp_check_landmarks(def, error) : result;
}

/* ---- rows ---- */

static void regi_nicp_free_rows(const sb_allocator *allocator, regi_nicp_rows *rows)
{
    sbi_free(allocator, rows->start);
    sbi_free(allocator, rows->nodes);
    sbi_free(allocator, rows->weights);
}

/* Rows chosen[count] of a mapping (NULL: all of them) as rows of one's own. */
static sb_result regi_nicp_copy_rows(const sb_mapping *from, const int *chosen, int count,
                                     const sb_allocator *allocator, regi_nicp_rows *rows, sb_error *error)
{
    size_t entries = 0;
    int at = 0;
    for (int i = 0; i < count; i++) {
        int row = chosen ? chosen[i] : i;
        entries += (size_t)(from->row_start[row + 1] - from->row_start[row]);
    }
    rows->start = (int *)sbi_alloc(allocator, (size_t)count + 1, sizeof(int));
    rows->nodes = (int *)sbi_alloc(allocator, entries, sizeof(int));
    rows->weights = (sb_real *)sbi_alloc(allocator, entries, sizeof(sb_real));
    if (!rows->start || !rows->nodes || !rows->weights)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d rows of weights", count);
    rows->start[0] = 0;
    for (int i = 0; i < count; i++) {
        int row = chosen ? chosen[i] : i;
        for (int k = from->row_start[row]; k < from->row_start[row + 1]; k++, at++) {
            rows->nodes[at] = from->nodes[k];
            rows->weights[at] = from->weights[k];
        }
        rows->start[i + 1] = at;
    }
    rows->mapping.row_count = count;
    rows->mapping.row_start = rows->start;
    rows->mapping.nodes = rows->nodes;
    rows->mapping.weights = rows->weights;
    return SB_OK;
}

/* Each of the nodes by itself. */
static sb_result regi_nicp_node_rows(const int *nodes, int count, const sb_allocator *allocator, regi_nicp_rows *rows,
                                     sb_error *error)
{
    size_t size = (size_t)count;
    rows->start = (int *)sbi_alloc(allocator, size + 1, sizeof(int));
    rows->nodes = (int *)sbi_alloc(allocator, size, sizeof(int));
    rows->weights = (sb_real *)sbi_alloc(allocator, size, sizeof(sb_real));
    if (!rows->start || !rows->nodes || !rows->weights)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d rows of weights", count);
    for (int i = 0; i <= count; i++)
        rows->start[i] = i;
    for (int i = 0; i < count; i++) {
        rows->nodes[i] = nodes[i];
        rows->weights[i] = 1;
    }
    rows->mapping.row_count = count;
    rows->mapping.row_start = rows->start;
    rows->mapping.nodes = rows->nodes;
    rows->mapping.weights = rows->weights;
    return SB_OK;
}

static sb_result regi_nicp_grid_rows(const reg_nicp_def *def, const sb_vec3 *points, int count, regi_nicp_rows *rows,
                                     sb_error *error)
{
    sb_grid_rows made;
    sb_result result;
    memset(&made, 0, sizeof made);
    result = sb_grid_map_points(def->grid, points, count, &def->allocator, &made, error);
    if (result == SB_OK)
        result = regi_nicp_copy_rows(&made.rows, NULL, count, &def->allocator, rows, error);
    sb_grid_rows_free(&made);
    return result;
}

/* Rows of points go with the pieces that have their material. */
static void regi_nicp_go_with_pieces(const regi_pieces *pieces, const sb_embedding *embedding, regi_nicp_rows *rows)
{
    const sb_mesh *mesh = pieces->mesh;
    int width = sb_mesh_element_width(mesh);
    for (int i = 0; i < rows->mapping.row_count; i++) {
        sb_embedded_point point;
        const int *from, *to;
        (void)sb_embedding_get_point(embedding, i, &point);
        from = mesh->elements + (size_t)point.element * (size_t)width;
        to = mesh->elements + (size_t)regi_pieces_find(pieces, point.element, point.xi) * (size_t)width;
        for (int k = rows->start[i]; k < rows->start[i + 1]; k++) {
            int a = 0;
            while (a < width - 1 && from[a] != rows->nodes[k])
                a++;
            rows->nodes[k] = to[a];
        }
    }
}

/* Rows of points at rest, through the grid or the elements. */
static sb_result regi_nicp_hold(const reg_nicp *nicp, const reg_nicp_def *def, const regi_pieces *pieces,
                                const sb_vec3 *points, int count, regi_nicp_rows *rows, sb_error *error)
{
    sb_embedding_def embed = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_embedding_rows made;
    sb_result result;
    if (def->grid)
        return regi_nicp_grid_rows(def, points, count, rows, error);
    memset(&made, 0, sizeof made);
    embed.mesh = &nicp->mesh;
    embed.points = points;
    embed.point_count = count;
    embed.kind = SB_EMBED_PLAIN;
    embed.max_distance = (sb_real)0.25 * nicp->size; /* beyond, the surface and the model are not of one organ */
    embed.allocator = def->allocator;
    embed.jobs = *sbi_body_jobs(def->body);
    result = sb_embedding_create(&embed, &embedding, error);
    if (result == SB_OK)
        result = sb_embedding_mapping(embedding, &def->allocator, &made, error);
    if (result == SB_OK)
        result = regi_nicp_copy_rows(&made.mapping, NULL, count, &def->allocator, rows, error);
    if (result == SB_OK && pieces->cells)
        regi_nicp_go_with_pieces(pieces, embedding, rows);
    sb_embedding_rows_free(&made);
    sb_embedding_destroy(embedding);
    return result;
}

/* ---- the organ's surface ---- */

/* The surface's triangles as the skin has them give each vertex its area, and a triangle to have a normal by. */
static void regi_nicp_measure(const sb_surface *skin, const sb_vec3 *points, sb_real *areas, int *home)
{
    const sb_real sixth = (sb_real)1 / 6;
    for (int t = 0; t < sb_surface_triangle_count(skin); t++) {
        int c[3];
        sb_vec3 along;
        sb_real area;
        (void)sb_surface_triangle(skin, t, c);
        along = sb_v3_sub(points[c[1]], points[c[0]]);
        area = sixth * sb_v3_norm(sb_v3_cross(along, sb_v3_sub(points[c[2]], points[c[0]])));
        for (int k = 0; k < 3; k++) {
            areas[c[k]] += area;
            home[c[k]] = 3 * t + k + 1; /* 0: none */
        }
    }
}

/* Which vertices stand for which: runs of the order of a tree of them, in which neighbours are neighbours. */
typedef struct regi_nicp_choice {
    int count;       /* of vertices that have an area */
    int *items;      /* [count] vertices */
    sb_vec3 *points; /* [count] */
    int *order;      /* [count] into items */
    sb_real spacing; /* m, mean distance of the points from their nearest */
} regi_nicp_choice;

static void regi_nicp_free_choice(const sb_allocator *allocator, regi_nicp_choice *choice)
{
    sbi_free(allocator, choice->items);
    sbi_free(allocator, choice->points);
    sbi_free(allocator, choice->order);
}

/* From a thousand of the points or so. */
static sb_real regi_nicp_spacing(const reg_kdtree *tree, const regi_nicp_choice *choice)
{
    int stride = 1 + choice->count / 1024, met = 0;
    double sum = 0;
    for (int i = 0; i < choice->count; i += stride) {
        int near[2];
        sb_real squared[2];
        if (reg_kdtree_k_nearest(tree, choice->points[i], 2, near, squared) < 2)
            continue;
        sum += sqrt((double)squared[1]);
        met++;
    }
    return met ? (sb_real)(sum / met) : 0;
}

/* Of the points whose areas (NULL: all count) are not 0. */
static sb_result regi_nicp_order(const sb_vec3 *points, const sb_real *areas, int count, const sb_allocator *allocator,
                                 regi_nicp_choice *choice, sb_error *error)
{
    reg_kdtree *tree = NULL;
    sb_result result;
    memset(choice, 0, sizeof *choice);
    choice->items = (int *)sbi_alloc(allocator, (size_t)count, sizeof(int));
    choice->points = (sb_vec3 *)sbi_alloc(allocator, (size_t)count, sizeof(sb_vec3));
    choice->order = (int *)sbi_alloc(allocator, (size_t)count, sizeof(int));
    if (!choice->items || !choice->points || !choice->order)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory to choose from %d points", count);
    for (int i = 0; i < count; i++)
        if (!areas || areas[i] > 0) {
            choice->items[choice->count] = i;
            choice->points[choice->count++] = points[i];
        }
    if (choice->count == 0)
        return sbi_fail(error, SB_ERROR_MESH, "the organ's surface has no area");
    result = reg_kdtree_create(choice->points, choice->count, allocator, &tree, error);
    if (result != SB_OK)
        return result;
    regi_kdtree_order(tree, choice->order);
    choice->spacing = regi_nicp_spacing(tree, choice);
    reg_kdtree_destroy(tree);
    return SB_OK;
}

/* First of run i of `count` runs. */
static int regi_nicp_run_start(const regi_nicp_choice *choice, int i, int count)
{
    return (int)((int64_t)i * choice->count / count);
}

/* The one of a run that is nearest to its middle. */
static int regi_nicp_middle(const regi_nicp_choice *choice, int first, int last)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    sb_real least = SB_REAL_MAX;
    int best = choice->order[first];
    for (int i = first; i < last; i++)
        sum = sb_v3_add(sum, choice->points[choice->order[i]]);
    sum = sb_v3_scale((sb_real)1 / (sb_real)(last - first), sum);
    for (int i = first; i < last; i++) {
        sb_vec3 d = sb_v3_sub(choice->points[choice->order[i]], sum);
        if (sb_v3_dot(d, d) < least) {
            least = sb_v3_dot(d, d);
            best = choice->order[i];
        }
    }
    return choice->items[best];
}

static void regi_nicp_make_sources(reg_nicp *nicp, const regi_nicp_choice *choice, const sb_real *areas,
                                   const int *home)
{
    for (int v = 0; v < nicp->vertex_count; v++)
        nicp->source_of[v] = -1;
    for (int i = 0; i < nicp->source_count; i++) {
        regi_nicp_source *source = nicp->sources + i;
        int first = regi_nicp_run_start(choice, i, nicp->source_count);
        int last = regi_nicp_run_start(choice, i + 1, nicp->source_count);
        source->vertex = regi_nicp_middle(choice, first, last);
        source->triangle = home[source->vertex] > 0 ? (home[source->vertex] - 1) / 3 : -1;
        source->corner = home[source->vertex] > 0 ? (home[source->vertex] - 1) % 3 : 0;
        source->guess = -1;
        for (int k = first; k < last; k++) {
            int vertex = choice->items[choice->order[k]];
            source->area += areas[vertex];
            nicp->source_of[vertex] = i;
        }
        nicp->total_area += (double)source->area;
    }
}

/* ---- memory ---- */

static void regi_nicp_layout(reg_nicp *nicp, sbi_arena *arena)
{
    size_t vertices = (size_t)nicp->vertex_count, sources = (size_t)nicp->source_count;
    size_t samples = (size_t)nicp->sample_count, larger = sources > samples ? sources : samples;
    nicp->vertices = (sb_vec3 *)sbi_arena_take(arena, vertices, sizeof(sb_vec3));
    nicp->source_of = (int *)sbi_arena_take(arena, vertices, sizeof(int));
    nicp->sources = (regi_nicp_source *)sbi_arena_take(arena, sources, sizeof(regi_nicp_source));
    nicp->samples = (regi_nicp_sample *)sbi_arena_take(arena, samples, sizeof(regi_nicp_sample));
    nicp->distances = (sb_real *)sbi_arena_take(arena, larger, sizeof(sb_real));
    nicp->scratch = (sb_real *)sbi_arena_take(arena, larger, sizeof(sb_real));
    nicp->goals = (sb_vec3 *)sbi_arena_take(arena, sources, sizeof(sb_vec3));
    nicp->stiffness = (sb_real *)sbi_arena_take(arena, sources, sizeof(sb_real));
    nicp->lines = (sb_vec3 *)sbi_arena_take(arena, sources, sizeof(sb_vec3));
    nicp->before = (sb_vec3 *)sbi_arena_take(arena, sources, sizeof(sb_vec3));
    nicp->settled = (sb_vec3 *)sbi_arena_take(arena, sources, sizeof(sb_vec3));
    nicp->targets = (sb_vec3 *)sbi_arena_take(arena, (size_t)nicp->landmark_count, sizeof(sb_vec3));
}

static sb_result regi_nicp_allocate(reg_nicp *nicp, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    regi_nicp_layout(nicp, &arena);
    nicp->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&nicp->allocator, 1, arena.used);
    if (!nicp->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d sources", nicp->source_count);
    arena.base = (unsigned char *)nicp->memory;
    arena.used = 0;
    regi_nicp_layout(nicp, &arena);
    return SB_OK;
}

/* ---- life ---- */

static sb_result regi_nicp_make_field(reg_nicp *nicp, const reg_nicp_def *def, sb_error *error)
{
    reg_field_def field = reg_default_field_def();
    field.surface = def->target;
    field.points = def->target_points;
    field.normals = def->target_normals;
    field.point_count = def->target_count;
    field.allocator = def->allocator;
    field.jobs = *sbi_body_jobs(def->body);
    return reg_field_create(&field, &nicp->field, error);
}

/* What the penalty is measured with. */
static sb_result regi_nicp_measure_body(reg_nicp *nicp, const sb_mesh *surface, const reg_nicp_def *def,
                                        sb_error *error)
{
    sb_vec3 low, high;
    sb_real share; /* of an element in the cube of the organ's size: its cube root is the element's size */
    sb_mesh_bounds(surface, &low, &high);
    nicp->size = sb_v3_norm(sb_v3_sub(high, low));
    nicp->young = sbi_body_young(nicp->body);
    if (!sb_is_finite(nicp->young) || !(nicp->young > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL, "the body's Young's modulus is %g", (double)nicp->young);
    share = def->grid ? def->grid->cell_size.x * def->grid->cell_size.y * def->grid->cell_size.z
                      : sb_mesh_volume(&nicp->mesh) / (sb_real)nicp->mesh.element_count;
    nicp->volume = sb_mesh_volume(&nicp->mesh);
    share /= nicp->size * nicp->size * nicp->size;
    nicp->landmark_stiffness = def->landmark_stiffness * nicp->young * nicp->size * sb_exp(sb_log(share) / 3);
    nicp->reach = def->reach * nicp->size;
    nicp->last_reach = def->last_reach * nicp->size;
    nicp->first_stiffness = def->first_stiffness * nicp->young / nicp->size;
    nicp->last_stiffness = def->last_stiffness * nicp->young / nicp->size;
    return SB_OK;
}

static void regi_nicp_set(reg_nicp *nicp, const reg_nicp_def *def)
{
    nicp->allocator = def->allocator;
    nicp->clock = def->clock;
    nicp->body = def->body;
    nicp->mesh_version = sb_body_mesh_version(def->body);
    nicp->view = def->view;
    nicp->camera = def->camera;
    nicp->blending = def->blending;
    nicp->sliding = def->sliding;
    nicp->least_cosine = def->least_cosine;
    nicp->noisy = def->noisy != 0;
    nicp->outliers = def->outliers;
    nicp->outlier_parameter = def->outlier_parameter;
    nicp->tolerance = def->tolerance;
    nicp->newton = def->newton;
    nicp->newton_tolerance = def->newton_tolerance;
    nicp->least_active = def->least_active;
    nicp->increments = def->increments;
    nicp->iterations = def->iterations;
    nicp->landmark_count = def->landmark_count;
    nicp->max_seconds = def->max_seconds;
}

/* Sources from the surface at rest. areas, home: scratch [nodes], zeroed. */
static sb_result regi_nicp_choose_sources(reg_nicp *nicp, const sb_mesh *surface, int most, sb_real *areas, int *home,
                                          sb_error *error)
{
    regi_nicp_choice choice;
    int *chosen;
    sb_result result;
    regi_nicp_measure(nicp->skin, surface->nodes, areas, home);
    result = regi_nicp_order(surface->nodes, areas, surface->node_count, &nicp->allocator, &choice, error);
    if (result == SB_OK) {
        nicp->vertex_count = surface->node_count;
        nicp->source_count = sbi_min_int(choice.count, most);
        result = regi_nicp_allocate(nicp, error);
    }
    if (result == SB_OK)
        regi_nicp_make_sources(nicp, &choice, areas, home);
    regi_nicp_free_choice(&nicp->allocator, &choice);
    if (result != SB_OK)
        return result;
    chosen = (int *)sbi_alloc(&nicp->allocator, (size_t)nicp->source_count, sizeof(int));
    if (!chosen)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d sources", nicp->source_count);
    for (int i = 0; i < nicp->source_count; i++)
        chosen[i] = nicp->sources[i].vertex;
    result = regi_nicp_copy_rows(&nicp->rows.mapping, chosen, nicp->source_count, &nicp->allocator, &nicp->source_rows,
                                 error);
    sbi_free(&nicp->allocator, chosen);
    return result;
}

static sb_result regi_nicp_take_surface(reg_nicp *nicp, const sb_mesh *surface, int most, sb_error *error)
{
    size_t count = (size_t)surface->node_count;
    sb_real *areas = (sb_real *)sbi_alloc_zeroed(&nicp->allocator, count, sizeof(sb_real));
    int *home = (int *)sbi_alloc_zeroed(&nicp->allocator, count, sizeof(int));
    sb_result result = areas && home ? SB_OK : sbi_fail(error, SB_ERROR_MEMORY, "no memory for the organ's surface");
    if (result == SB_OK)
        result = regi_nicp_choose_sources(nicp, surface, most, areas, home, error);
    sbi_free(&nicp->allocator, areas);
    sbi_free(&nicp->allocator, home);
    return result;
}

/* The target's points that look for sources; they are counted before there is memory for them. */
static sb_result regi_nicp_choose_samples(reg_nicp *nicp, const reg_nicp_def *def, regi_nicp_choice *choice,
                                          sb_error *error)
{
    const sb_vec3 *points = def->target ? def->target->nodes : def->target_points;
    int count = def->target ? def->target->node_count : def->target_count;
    sb_result result = regi_nicp_order(points, NULL, count, &nicp->allocator, choice, error);
    nicp->sample_count = sbi_min_int(choice->count, def->samples);
    nicp->is_cloud = !def->target;
    nicp->spacing = choice->spacing;
    return result;
}

static void regi_nicp_make_samples(reg_nicp *nicp, const regi_nicp_choice *choice)
{
    for (int i = 0; i < nicp->sample_count; i++) {
        regi_nicp_sample *sample = nicp->samples + i;
        reg_field_hit hit;
        sample->point = choice->points[choice->order[regi_nicp_run_start(choice, i, nicp->sample_count)]];
        sample->guess = -1;
        if (reg_field_closest(nicp->field, sample->point, -1, &hit))
            sample->normal = hit.normal;
    }
}

/* The penalties, without force so far. */
static sb_result regi_nicp_add_loads(reg_nicp *nicp, const reg_nicp_def *def, sb_error *error)
{
    const sb_real none = 0;
    sb_result result;
    regi_nicp_points(nicp, &nicp->source_rows, nicp->goals);
    result =
        sb_body_add_mapping(nicp->body, &nicp->source_rows.mapping, &none, 1, nicp->goals, &nicp->surface_load, error);
    if (result == SB_OK && sbi_body_reserve_mapping_lines(nicp->body, nicp->surface_load) != SB_OK)
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the lines of %d sources", nicp->source_count);
    if (result != SB_OK || nicp->landmark_count == 0)
        return result;
    memcpy(nicp->targets, def->landmark_targets, (size_t)nicp->landmark_count * sizeof(sb_vec3));
    return sb_body_add_mapping(nicp->body, &nicp->landmark_rows.mapping, &none, 1, nicp->targets, &nicp->landmark_load,
                               error);
}

static sb_result regi_nicp_build_on(reg_nicp *nicp, const reg_nicp_def *def, const regi_pieces *pieces,
                                    const sb_boundary *skin, sb_error *error)
{
    const sb_mesh *surface = &skin->surface;
    regi_nicp_choice samples;
    sb_result result = sb_surface_create(surface, &def->allocator, &nicp->skin, error);
    if (result == SB_OK)
        result = regi_nicp_measure_body(nicp, surface, def, error);
    if (result == SB_OK)
        result = regi_nicp_make_field(nicp, def, error);
    if (result == SB_OK)
        result = def->surface
                     ? regi_nicp_hold(nicp, def, pieces, surface->nodes, surface->node_count, &nicp->rows, error)
                     : regi_nicp_node_rows(skin->nodes, surface->node_count, &def->allocator, &nicp->rows, error);
    if (result == SB_OK && nicp->landmark_count)
        result = regi_nicp_hold(nicp, def, pieces, def->landmarks, nicp->landmark_count, &nicp->landmark_rows, error);
    if (result != SB_OK)
        return result;
    result = regi_nicp_choose_samples(nicp, def, &samples, error);
    if (result == SB_OK)
        result = regi_nicp_take_surface(nicp, surface, def->sources, error);
    if (result == SB_OK)
        regi_nicp_make_samples(nicp, &samples);
    regi_nicp_free_choice(&nicp->allocator, &samples);
    return result == SB_OK ? regi_nicp_add_loads(nicp, def, error) : result;
}

static sb_result regi_nicp_build(reg_nicp *nicp, const reg_nicp_def *def, sb_error *error)
{
    regi_pieces pieces;
    sb_boundary skin;
    sb_result result = sbi_body_copy_mesh(def->body, &def->allocator, &nicp->mesh, error);
    if (result != SB_OK)
        return result;
    regi_nicp_set(nicp, def);
    result = regi_pieces_make(def->body, &nicp->mesh, &def->allocator, &pieces, error);
    if (result == SB_OK)
        result = regi_pieces_skin(&pieces, def->surface, &skin, error);
    if (result == SB_OK) {
        result = regi_nicp_build_on(nicp, def, &pieces, &skin, error);
        sb_boundary_free(&skin);
    }
    regi_pieces_free(&pieces);
    return result;
}

REG_API sb_result reg_nicp_create(const reg_nicp_def *def, reg_nicp **nicp, sb_error *error)
{
    reg_nicp *made;
    sb_result result = regi_nicp_check(def, error);
    if (result == SB_OK && !nicp)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "there is no place for the registration");
    if (result != SB_OK)
        return result;
    made = (reg_nicp *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a registration");
    made->allocator = def->allocator;
    result = regi_nicp_build(made, def, error);
    if (result != SB_OK) {
        reg_nicp_destroy(made);
        return result;
    }
    reg_nicp_restart(made);
    *nicp = made;
    return SB_OK;
}

REG_API void reg_nicp_destroy(reg_nicp *nicp)
{
    sb_allocator allocator;
    if (!nicp)
        return;
    allocator = nicp->allocator;
    if (nicp->landmark_load)
        (void)sb_body_remove_load(nicp->body, nicp->landmark_load);
    if (nicp->surface_load)
        (void)sb_body_remove_load(nicp->body, nicp->surface_load);
    sb_mesh_free(&nicp->mesh);
    reg_field_destroy(nicp->field);
    sb_surface_destroy(nicp->skin);
    regi_nicp_free_rows(&allocator, &nicp->rows);
    regi_nicp_free_rows(&allocator, &nicp->source_rows);
    regi_nicp_free_rows(&allocator, &nicp->landmark_rows);
    sbi_free(&allocator, nicp->memory);
    sbi_free(&allocator, nicp);
}

REG_API void reg_nicp_restart(reg_nicp *nicp)
{
    double seconds;
    if (!nicp)
        return;
    seconds = nicp->info.seconds;
    memset(&nicp->info, 0, sizeof nicp->info);
    nicp->info.seconds = seconds;
    nicp->info.error.element = nicp->info.error.node = -1;
    nicp->increment = nicp->iteration = nicp->has_settled = 0;
}

/* ---- landmarks and readings ---- */

REG_API sb_result reg_nicp_move_landmarks(reg_nicp *nicp, const sb_vec3 *targets)
{
    if (!nicp || (!targets && nicp->landmark_count))
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < nicp->landmark_count; i++)
        if (!sb_v3_is_finite(targets[i]))
            return SB_ERROR_NOT_FINITE;
    if (nicp->landmark_count) {
        sb_result result = sb_body_set_mapping_targets(nicp->body, nicp->landmark_load, targets);
        if (result != SB_OK)
            return result;
        memcpy(nicp->targets, targets, (size_t)nicp->landmark_count * sizeof(sb_vec3));
    }
    nicp->has_settled = nicp->iteration = 0;
    nicp->info.stop = REG_NICP_RUNNING;
    return SB_OK;
}

REG_API void reg_nicp_landmarks(const reg_nicp *nicp, sb_vec3 *points)
{
    if (!nicp || !points || sbi_body_check_version(nicp->body, nicp->mesh_version, NULL) != SB_OK)
        return;
    if (nicp->landmark_count)
        regi_nicp_points(nicp, &nicp->landmark_rows, points);
}

REG_API const sb_body *reg_nicp_body(const reg_nicp *nicp) { return nicp ? nicp->body : NULL; }

REG_API reg_nicp_info reg_nicp_get_info(const reg_nicp *nicp)
{
    reg_nicp_info none;
    if (!nicp) {
        memset(&none, 0, sizeof none);
        return none;
    }
    return nicp->info;
}

REG_API int reg_nicp_surface_count(const reg_nicp *nicp) { return nicp ? nicp->vertex_count : 0; }

REG_API void reg_nicp_positions(const reg_nicp *nicp, sb_vec3 *points)
{
    if (!nicp || !points || sbi_body_check_version(nicp->body, nicp->mesh_version, NULL) != SB_OK)
        return;
    regi_nicp_points(nicp, &nicp->rows, points);
}

REG_API int reg_nicp_source_count(const reg_nicp *nicp) { return nicp ? nicp->source_count : 0; }

REG_API sb_result reg_nicp_get_source(const reg_nicp *nicp, int index, reg_nicp_source *source)
{
    const regi_nicp_source *from;
    if (!nicp || !source)
        return SB_ERROR_ARGUMENT;
    if (index < 0 || index >= nicp->source_count)
        return SB_ERROR_INDEX;
    from = nicp->sources + index;
    source->vertex = from->vertex;
    source->point = nicp->before[index];
    source->goal = nicp->goals[index];
    source->area = from->area;
    source->distance = from->distance;
    source->visible = from->visible;
    source->active = from->active;
    return SB_OK;
}

/* ==== src/register/nicp_step.c ==== */
/* nicp_step: a look at the target, partners both ways, and the balance after it. */
#include <string.h>


static double regi_nicp_now(const reg_nicp *nicp) { return nicp->clock ? nicp->clock() : 0.0; }

REGI_API void regi_nicp_points(const reg_nicp *nicp, const regi_nicp_rows *rows, sb_vec3 *points)
{
    sb_mapping_apply(&rows->mapping, sb_body_positions(nicp->body), points);
}

/* ---- what the camera sees ---- */

static sb_vec3 regi_nicp_normal(const reg_nicp *nicp, const regi_nicp_source *source)
{
    sb_surface_hit corner;
    memset(&corner, 0, sizeof corner);
    if (source->triangle < 0)
        return sb_v3(0, 0, 0);
    corner.triangle = source->triangle;
    corner.feature = SB_SURFACE_VERTEX;
    corner.index = source->corner;
    return sb_surface_normal(nicp->skin, &corner);
}

static int regi_nicp_sees(const reg_nicp *nicp, const regi_nicp_source *source)
{
    sb_vec3 at = nicp->vertices[source->vertex], way = sb_v3_sub(nicp->camera, at);
    sb_real length = sb_v3_norm(way), clear = (sb_real)1e-3 * nicp->size;
    if (nicp->view == REG_NICP_ALL)
        return 1;
    if (!(sb_v3_dot(source->normal, way) > 0))
        return 0;
    if (nicp->view == REG_NICP_FACING || !(length > clear))
        return 1;
    at = sb_v3_madd(at, clear, source->normal); /* off its own facets */
    way = sb_v3_sub(nicp->camera, at);
    return !sb_surface_ray(nicp->skin, at, way, sb_v3_norm(way), NULL);
}

/* ---- partners ---- */

/* 1 unless both normals are known and look different ways. */
static int regi_nicp_agrees(const reg_nicp *nicp, sb_vec3 a, sb_vec3 b)
{
    return sb_v3_dot(a, a) == 0 || sb_v3_dot(b, b) == 0 || sb_v3_dot(a, b) > nicp->least_cosine;
}

/* Beyond the rim of what was seen, where the closest place is the rim itself. A surface knows its rim. Of a cloud's
 * point the way back tells: on the rim it does not lead to the source but to what is above the rim. */
static int regi_nicp_is_beyond(const reg_nicp *nicp, regi_nicp_source *source, sb_vec3 at, const reg_field_hit *hit)
{
    sb_surface_hit back;
    sb_real aside;
    if (!nicp->is_cloud)
        return hit->on_border;
    if (!sb_surface_closest_from(nicp->skin, hit->point, SB_REAL_MAX, source->way_back, &back))
        return 1;
    source->way_back = back.triangle;
    aside = sb_v3_norm(sb_v3_sub(back.point, at));
    return aside > (sb_real)0.7 * hit->distance && aside > 2 * nicp->spacing;
}

static void regi_nicp_look_at(reg_nicp *nicp, regi_nicp_source *source)
{
    sb_vec3 at = nicp->vertices[source->vertex];
    reg_field_hit hit;
    source->normal = regi_nicp_normal(nicp, source);
    source->direction = source->normal;
    source->visible = regi_nicp_sees(nicp, source);
    source->paired = source->visible && reg_field_closest(nicp->field, at, source->guess, &hit);
    if (!source->paired)
        return;
    source->guess = hit.item;
    source->distance = hit.distance;
    source->way = sb_v3_sub(hit.point, at);
    source->paired = regi_nicp_agrees(nicp, source->normal, hit.normal) && !regi_nicp_is_beyond(nicp, source, at, &hit);
    if (sb_v3_dot(hit.normal, hit.normal) > 0 && !nicp->noisy)
        source->direction = hit.normal;
}

static void regi_nicp_look_chunk(void *user, int chunk)
{
    reg_nicp *nicp = (reg_nicp *)user;
    int first = chunk * REGI_NICP_CHUNK, last = sbi_min_int(first + REGI_NICP_CHUNK, nicp->source_count);
    for (int i = first; i < last; i++)
        regi_nicp_look_at(nicp, nicp->sources + i);
}

/* The source that stands for the corner that the closest place of the skin is nearest to. */
static void regi_nicp_look_back(reg_nicp *nicp, regi_nicp_sample *sample)
{
    sb_surface_hit hit;
    int nodes[3], nearest = 0;
    sample->source = -1;
    if (!sb_surface_closest_from(nicp->skin, sample->point, SB_REAL_MAX, sample->guess, &hit))
        return;
    sample->guess = hit.triangle;
    if (!regi_nicp_agrees(nicp, sb_surface_normal(nicp->skin, &hit), sample->normal))
        return;
    (void)sb_surface_triangle(nicp->skin, hit.triangle, nodes);
    for (int k = 1; k < 3; k++)
        if (hit.weights[k] > hit.weights[nearest])
            nearest = k;
    sample->source = nicp->source_of[nodes[nearest]];
    sample->way = sb_v3_sub(sample->point, hit.point);
}

static void regi_nicp_look_back_chunk(void *user, int chunk)
{
    reg_nicp *nicp = (reg_nicp *)user;
    int first = chunk * REGI_NICP_CHUNK, last = sbi_min_int(first + REGI_NICP_CHUNK, nicp->sample_count);
    for (int i = first; i < last; i++)
        regi_nicp_look_back(nicp, nicp->samples + i);
}

/* Share of the way of what changes geometrically over the increments: from^(1 - share) to^share. */
static sb_real regi_nicp_between(sb_real from, sb_real to, sb_real share)
{
    return from * sb_exp(share * sb_log(to / from));
}

static sb_real regi_nicp_reach(const reg_nicp *nicp)
{
    sb_real last = (sb_real)sbi_max_int(nicp->increments - 1, 1);
    return regi_nicp_between(nicp->reach, nicp->last_reach, (sb_real)nicp->increment / last);
}

/* Largest distance[count] that counts. */
static sb_real regi_nicp_limit(const reg_nicp *nicp, int count)
{
    sb_real limit = reg_outlier_limit(nicp->distances, count, nicp->outliers, nicp->outlier_parameter, nicp->scratch);
    return sb_max(limit, regi_nicp_reach(nicp));
}

static void regi_nicp_prune_sources(reg_nicp *nicp)
{
    sb_real limit;
    int count = 0;
    for (int i = 0; i < nicp->source_count; i++)
        if (nicp->sources[i].paired)
            nicp->distances[count++] = nicp->sources[i].distance;
    limit = regi_nicp_limit(nicp, count);
    for (int i = 0; i < nicp->source_count; i++)
        nicp->sources[i].paired = nicp->sources[i].paired && nicp->sources[i].distance <= limit;
}

/* V(i), without the pairs that are too far apart. */
static void regi_nicp_gather_samples(reg_nicp *nicp)
{
    sb_real limit;
    int count = 0;
    for (int i = 0; i < nicp->source_count; i++) {
        nicp->sources[i].sum = sb_v3(0, 0, 0);
        nicp->sources[i].count = 0;
    }
    for (int j = 0; j < nicp->sample_count; j++)
        if (nicp->samples[j].source >= 0)
            nicp->distances[count++] = sb_v3_norm(nicp->samples[j].way);
    limit = regi_nicp_limit(nicp, count);
    for (int j = 0; j < nicp->sample_count; j++) {
        const regi_nicp_sample *sample = nicp->samples + j;
        if (sample->source >= 0 && sb_v3_norm(sample->way) <= limit) {
            regi_nicp_source *source = nicp->sources + sample->source;
            source->sum = sb_v3_add(source->sum, sample->way);
            source->count++;
        }
    }
}

/* (5.4) */
static sb_vec3 regi_nicp_blend(const reg_nicp *nicp, const regi_nicp_source *source)
{
    if (source->count == 0)
        return source->way;
    return sb_v3_madd(sb_v3_scale(nicp->blending, source->way), (1 - nicp->blending) / (sb_real)source->count,
                      source->sum);
}

/* Stiffness and goal of each source; what is told of them. */
static void regi_nicp_set_goals(reg_nicp *nicp, sb_real stiffness)
{
    double area = 0, mean = 0;
    sb_real slide = sb_sqrt(nicp->sliding);
    reg_nicp_info *info = &nicp->info;
    info->visible = info->pruned = 0;
    info->max_distance = 0;
    for (int i = 0; i < nicp->source_count; i++) {
        regi_nicp_source *source = nicp->sources + i;
        nicp->goals[i] = nicp->before[i] = nicp->vertices[source->vertex];
        source->active = source->paired;
        nicp->lines[i] = sb_v3_scale(slide, source->direction);
        nicp->stiffness[i] = source->active ? stiffness * source->area : 0;
        info->visible += source->visible;
        info->pruned += source->visible && !source->active;
        if (!source->active)
            continue;
        nicp->goals[i] = sb_v3_add(nicp->goals[i], regi_nicp_blend(nicp, source));
        area += (double)source->area;
        mean += (double)source->area * (double)source->distance;
        info->max_distance = sb_max(info->max_distance, source->distance);
    }
    info->active = (sb_real)(area / nicp->total_area);
    info->mean_distance = area > 0 ? (sb_real)(mean / area) : 0;
}

static sb_result regi_nicp_pair(reg_nicp *nicp, sb_real stiffness)
{
    const sb_jobs *jobs = sbi_body_jobs(nicp->body);
    sb_result result;
    regi_nicp_points(nicp, &nicp->rows, nicp->vertices);
    result = sb_surface_move(nicp->skin, nicp->vertices, jobs, &nicp->info.error);
    if (result != SB_OK)
        return result;
    sbi_run(jobs, regi_nicp_look_chunk, nicp, (nicp->source_count + REGI_NICP_CHUNK - 1) / REGI_NICP_CHUNK);
    if (nicp->blending < 1)
        sbi_run(jobs, regi_nicp_look_back_chunk, nicp, (nicp->sample_count + REGI_NICP_CHUNK - 1) / REGI_NICP_CHUNK);
    regi_nicp_prune_sources(nicp);
    regi_nicp_gather_samples(nicp);
    regi_nicp_set_goals(nicp, stiffness);
    if (nicp->info.active < nicp->least_active && nicp->landmark_count == 0)
        return sbi_fail(&nicp->info.error, SB_ERROR_NOT_CONVERGED,
                        "only %.1f %% of the organ's surface has a partner "
                        "on the target: align them first",
                        100 * (double)nicp->info.active);
    return SB_OK;
}

/* ---- balance ---- */

/* The balance with rows that are soft along the surface. Penalties act within it only: who steps the body between two
 * looks has it to himself. */
static sb_result regi_nicp_solve(reg_nicp *nicp, const sb_static_options *options, sb_step_info *step)
{
    const sb_real none = 0;
    sb_body *body = nicp->body;
    sb_result result = sb_body_solve_static(body, options, step);
    (void)sbi_body_set_mapping_lines(body, nicp->surface_load, NULL);
    (void)sb_body_set_mapping_stiffness(body, nicp->surface_load, &none, 1);
    if (nicp->landmark_load)
        (void)sb_body_set_mapping_stiffness(body, nicp->landmark_load, &none, 1);
    return result;
}

static sb_result regi_nicp_balance(reg_nicp *nicp)
{
    sb_static_options options = sb_default_static_options();
    sb_step_info step;
    sb_result result = sb_body_set_mapping_targets(nicp->body, nicp->surface_load, nicp->goals);
    if (result == SB_OK)
        result = sb_body_set_mapping_stiffness(nicp->body, nicp->surface_load, nicp->stiffness, 0);
    if (result == SB_OK && nicp->landmark_load)
        result = sb_body_set_mapping_stiffness(nicp->body, nicp->landmark_load, &nicp->landmark_stiffness, 1);
    if (result == SB_OK)
        result = sbi_body_set_mapping_lines(nicp->body, nicp->surface_load, nicp->lines);
    if (result == SB_ERROR_MEMORY)
        return sbi_fail(&nicp->info.error, result, "no memory for the lines of %d sources", nicp->source_count);
    if (result != SB_OK)
        return sbi_fail(&nicp->info.error, result, "the penalties of the registration are gone from the body");
    options.tolerance = nicp->newton_tolerance;
    options.max_newton = nicp->newton;
    options.quasi_newton = options.forces_only = 1; /* the next look changes the forces more than that leaves */
    options.max_iterations = sbi_body_max_iterations(nicp->body);
    options.keep_progress = 1; /* the next look starts from there */
    result = regi_nicp_solve(nicp, &options, &step);
    nicp->info.newton_iterations = step.newton_iterations;
    nicp->info.pcg_iterations = step.pcg_iterations;
    if (result != SB_OK && step.load_steps == 0) {
        nicp->info.error = step.error;
        return result;
    }
    return SB_OK;
}

/* rms distance of the sources from where they were (m). */
static sb_real regi_nicp_motion(const reg_nicp *nicp, const sb_vec3 *from)
{
    double sum = 0;
    for (int i = 0; i < nicp->source_count; i++) {
        sb_vec3 d = sb_v3_sub(nicp->vertices[nicp->sources[i].vertex], from[i]);
        sum += (double)nicp->sources[i].area * (double)sb_v3_dot(d, d);
    }
    return (sb_real)sqrt(sum / nicp->total_area);
}

/* ---- control ---- */

/* k0 (k1 / k0)^(i / n), i from 1. */
static sb_real regi_nicp_stiffness(const reg_nicp *nicp)
{
    return regi_nicp_between(nicp->first_stiffness, nicp->last_stiffness,
                             (sb_real)(nicp->increment + 1) / (sb_real)nicp->increments);
}

/* An increment ends when a look changes nothing more, or when it has had its looks; the run when two increments end
 * alike. */
static void regi_nicp_judge(reg_nicp *nicp)
{
    sb_real least = nicp->tolerance * nicp->size;
    if (++nicp->iteration < nicp->iterations && nicp->info.change > least)
        return;
    if (nicp->increment + 1 == nicp->increments)
        nicp->info.stop = REG_NICP_INCREMENTS;
    else if (nicp->has_settled && regi_nicp_motion(nicp, nicp->settled) <= least)
        nicp->info.stop = REG_NICP_CONVERGED;
    for (int i = 0; i < nicp->source_count; i++)
        nicp->settled[i] = nicp->vertices[nicp->sources[i].vertex];
    nicp->has_settled = 1;
    nicp->iteration = 0;
    nicp->increment = sbi_min_int(nicp->increment + 1, nicp->increments - 1);
}

static void regi_nicp_read_landmarks(reg_nicp *nicp)
{
    const sb_mapping *rows = &nicp->landmark_rows.mapping;
    sb_real most = 0;
    for (int i = 0; i < nicp->landmark_count; i++) {
        sb_vec3 at = sb_v3(0, 0, 0);
        for (int k = rows->row_start[i]; k < rows->row_start[i + 1]; k++)
            at = sb_v3_madd(at, rows->weights[k], sb_body_positions(nicp->body)[rows->nodes[k]]);
        most = sb_max(most, sb_v3_norm(sb_v3_sub(nicp->targets[i], at)));
    }
    nicp->info.landmark_distance = most;
}

/* Of a point, a flat patch or a target in another unit the penalties make what no organ looks like. */
static sb_result regi_nicp_check_shape(reg_nicp *nicp)
{
    sb_mesh mesh = nicp->mesh;
    double share;
    mesh.nodes = sbi_body_shape(nicp->body).nodes;
    share = (double)(sb_mesh_volume(&mesh) / nicp->volume);
    if (share > 0.25 && share < 4)
        return SB_OK;
    return sbi_fail(&nicp->info.error, SB_ERROR_DIVERGED,
                    "the organ's volume has become %.3g times what it was: the "
                    "target shows a part of it only, or is of another size",
                    share);
}

static sb_result regi_nicp_try(reg_nicp *nicp)
{
    double begin = regi_nicp_now(nicp), paired;
    sb_real stiffness = regi_nicp_stiffness(nicp);
    sb_result result;
    regi_nicp_read_landmarks(nicp);
    result = nicp->info.iterations > 0 ? regi_nicp_check_shape(nicp) : SB_OK;
    if (result == SB_OK)
        result = regi_nicp_pair(nicp, stiffness);
    paired = regi_nicp_now(nicp);
    nicp->info.seconds_pairs = paired - begin;
    if (result == SB_OK)
        result = regi_nicp_balance(nicp);
    nicp->info.seconds_solve = regi_nicp_now(nicp) - paired;
    if (result != SB_OK)
        return result;
    regi_nicp_points(nicp, &nicp->rows, nicp->vertices);
    nicp->info.change = regi_nicp_motion(nicp, nicp->before);
    nicp->info.stiffness = stiffness;
    nicp->info.increment = nicp->increment + 1;
    nicp->info.stop = REG_NICP_RUNNING;
    nicp->info.iterations++;
    regi_nicp_judge(nicp);
    return SB_OK;
}

REG_API sb_result reg_nicp_step(reg_nicp *nicp, reg_nicp_info *info)
{
    sb_result result;
    double begin;
    if (!nicp)
        return SB_ERROR_ARGUMENT;
    begin = regi_nicp_now(nicp);
    memset(&nicp->info.error, 0, sizeof nicp->info.error);
    nicp->info.error.element = nicp->info.error.node = -1;
    result = sbi_body_check_version(nicp->body, nicp->mesh_version, &nicp->info.error);
    if (result == SB_OK)
        result = regi_nicp_try(nicp);
    nicp->info.seconds += regi_nicp_now(nicp) - begin;
    if (result == SB_ERROR_STATE)
        nicp->info.stop = REG_NICP_FAILED;
    else if (result != SB_OK)
        nicp->info.stop =
            nicp->info.active < nicp->least_active && nicp->landmark_count == 0 ? REG_NICP_NO_OVERLAP : REG_NICP_FAILED;
    if (info)
        *info = nicp->info;
    return result;
}

REG_API sb_result reg_nicp_run(reg_nicp *nicp, int steps, reg_nicp_info *info)
{
    sb_result result = SB_OK;
    if (!nicp || steps < 1)
        return SB_ERROR_ARGUMENT;
    nicp->info.stop = REG_NICP_RUNNING;
    for (int i = 0; result == SB_OK && nicp->info.stop == REG_NICP_RUNNING; i++) {
        if (i == steps)
            nicp->info.stop = REG_NICP_STEP_CAP;
        else if (nicp->info.seconds >= nicp->max_seconds)
            nicp->info.stop = REG_NICP_TIME_CAP;
        else
            result = reg_nicp_step(nicp, NULL);
    }
    if (info)
        *info = nicp->info;
    return result;
}

/* ==== src/register/loads.c ==== */
/* loads: see loads.h. */

#include <string.h>


#define REGI_LOADS_COOKIE 0x6c6f6164u

enum {
    REGI_LOADS_SLAB = 96,  /* force components per product of the dense system */
    REGI_LOADS_SMOOTH = 2, /* times that tractions are averaged over facets */
    REGI_LOADS_POSE = 6,   /* moves along the axes and turns about them, */
    REGI_LOADS_FREE = 8,   /* and tilts of the drag: what is found beside the forces */
    REGI_LOADS_ALONE = 2,  /* rounds before a drag is looked for */
    REGI_LOADS_LOOKS = 2,  /* times that its region is decided */
    REGI_LOADS_AFTER = 2,  /* rounds that have to follow the second, as it may move much */
    REGI_LOADS_LEAST = 10  /* parts of one: fewer cannot be told from what is around them */
};

typedef struct regi_loads {
    const reg_loads_def *def;
    reg_match *match;
    sb_body *body;
    sb_boundary boundary;
    sb_direct *direct;
    int wide; /* of the fronts' arithmetic */
    void *memory;
    int node_count;
    int sample_count, sample_most; /* multiples of 3 */
    int part_count;  /* of the surface: possible samples; three of each landmark follow, and two of each part that
                      * is dragged */
    int drag_first;  /* the first of the latter */
    int *sample_of;  /* [sample_most] which of those a sample is; -1: none, it fills up the last group */
    int drag_sample; /* the first of a dragged part */
    int load_count;  /* surface nodes that may bear a force */
    int *load_nodes; /* [load_count] */
    sb_real *area;   /* [nodes] of the surface at a node (m^2), 0 inside */
    double total_area;
    int *part;                             /* [charges] that a charge belongs to */
    int *part_start;                       /* [part_count + 1] into part_charges */
    int *part_charges;                     /* [charges] by part */
    int *part_centre;                      /* [part_count] a charge */
    sb_real *part_load;                    /* [part_count] mean traction (Pa) */
    unsigned char *is_dragged, *votes;     /* [part_count] */
    int drag_looks, drag_count, drag_most; /* looks: how often its region is still to be decided */
    int *drag_parts;                       /* [drag_most] */
    sb_vec3 drag, across[2];               /* unit vectors: of the drag, and at right angles to it */
    sb_real drag_spread;                   /* of the motions about it, as share of them */
    double effort;                         /* of the last round without a drag */
    sb_real scatter;                       /* of a charge's gap about the mean of its part: variance (m^2) */
    sb_real *spread;                       /* [charges] squared distance from the centre of its part (m^2) */
    sb_real *rows;                         /* [SBI_FRONT_GROUP][nodes][3] samples, and their responses */
    sb_real *response;                     /* [load_count][3][sample_count]: of each sample's gap to a force (m/N) */
    sb_real *gap;                          /* [sample_most] that forces have to close (m) */
    sb_real *variance;   /* [sample_count] of a part misfit^2, over the share of it that acts; 0: the sample is off */
    sb_real *system;     /* [sample_count][sample_count] */
    sb_real *multiplier; /* [sample_count] y */
    sb_real *signs, *sizes; /* [sample_count] of the factor */
    sb_real *slab;          /* [SLAB][SLAB + sample_count] */
    sb_real *pack;
    sb_real *weight;            /* [load_count] w */
    sb_real *traction;          /* [nodes] */
    sb_real *average;           /* [nodes] */
    sb_real *touch;             /* [nodes] facets */
    sb_vec3 *force;             /* [nodes] found (N) */
    sb_vec3 *residual;          /* [nodes] internal less known forces (N) */
    sb_vec3 *increment;         /* [nodes] of a round (m) */
    const unsigned char *fixed; /* [nodes] axes of the body's supports */
    int *held_nodes;            /* [nodes] scratch: nodes held along the same axes, */
    sb_vec3 *held_goals;        /* [nodes] and where they are sent */
    sb_vec3 *before, *goals;    /* [nodes] displacement at the beginning, and where held nodes were to be then (m) */
    int posed;                  /* 1: the pose is sought, too */
    sb_vec3 centre;             /* m: of the held nodes at the beginning, or of all; turns are about it */
    sb_real likely[REGI_LOADS_FREE];                      /* sd of the pose (m, rad), and of tilts (rad) */
    sb_real pose[REGI_LOADS_POSE], next[REGI_LOADS_POSE]; /* reached, and found in this round: m, rad */
    sb_real *free_rows; /* [sample_count][FREE] a sample's motion with pose and tilt, in sd */
    double begun;       /* on the clock */
    reg_loads_info info;
} regi_loads;

REG_API reg_loads_def reg_default_loads_def(void)
{
    reg_loads_def def;
    memset(&def, 0, sizeof def);
    def.samples = 300;
    def.rounds = 10;
    def.reweights = 9;
    def.misfit = (sb_real)6e-5;
    def.power = (sb_real)0.5;
    def.floor = (sb_real)0.01;
    def.landmark = (sb_real)1e-3;
    def.drag = (sb_real)0.01;
    def.pose = 0;
    def.max_seconds = 1e9;
    def.cookie = REGI_LOADS_COOKIE;
    return def;
}

static sb_result regi_loads_check(const reg_loads_def *def, sb_error *error)
{
    if (!def || def->cookie != REGI_LOADS_COOKIE || !def->match)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "loads need a def made by reg_default_loads_def, and a match");
    if (def->samples < 30 || def->samples > 3000 || def->rounds < 1 || def->rounds > 100 || def->reweights < 1 ||
        def->reweights > 1000)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d samples, %d rounds, %d reweights: out of range", def->samples,
                        def->rounds, def->reweights);
    if (!(def->misfit > 0) || !sb_is_finite(def->misfit) || !(def->power > 0 && def->power <= 2) || !(def->floor > 0) ||
        !sb_is_finite(def->floor) || !(def->pose >= 0) || !sb_is_finite(def->pose) ||
        !(def->drag >= 0 && def->drag < 1) || !(def->landmark >= (sb_real)1e-6 && def->landmark <= 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "misfit %g, power %g, floor %g, landmark %g, drag %g, pose %g: out of "
                        "range",
                        (double)def->misfit, (double)def->power, (double)def->floor, (double)def->landmark,
                        (double)def->drag, (double)def->pose);
    if (!(def->max_seconds > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_seconds is %g, not above 0", def->max_seconds);
    if (def->match->method != REG_PBSM)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "loads need a match by distance");
    if (sbi_body_load_count(def->match->body) > 0 || sbi_body_has_constraints(def->match->body))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "loads need a body without pressures, springs and constraints");
    return sbi_body_check_version(def->match->body, def->match->mesh_version, error);
}

static double regi_loads_now(const regi_loads *l) { return l->def->clock ? l->def->clock() : 0.0; }

/* ---- what stays: nodes, parts of the surface ---- */

/* Shares the area of the body's facets out to their nodes. */
static void regi_loads_measure_nodes(regi_loads *l)
{
    const sb_mesh *skin = &l->boundary.surface;
    int width = sb_mesh_element_width(skin), corners = sb_element_corner_count(skin->element_type);
    memset(l->area, 0, (size_t)l->node_count * sizeof(sb_real));
    for (int f = 0; f < skin->element_count; f++) {
        const int *c = skin->elements + (size_t)f * (size_t)width;
        sb_vec3 d = sb_v3_sub(skin->nodes[c[corners - 1]], skin->nodes[c[0]]), area;
        area = sb_v3_cross(sb_v3_sub(skin->nodes[c[1]], skin->nodes[c[0]]), d);
        if (corners == 4) {
            d = sb_v3_sub(skin->nodes[c[3]], skin->nodes[c[1]]);
            area = sb_v3_cross(sb_v3_sub(skin->nodes[c[2]], skin->nodes[c[0]]), d);
        }
        for (int k = 0; k < width; k++)
            l->area[l->boundary.nodes[c[k]]] += sb_v3_norm(area) / (2 * (sb_real)width);
    }
    l->load_count = 0;
    l->total_area = 0;
    for (int i = 0; i < l->node_count; i++) {
        l->total_area += (double)l->area[i];
        if (l->area[i] > 0 && l->fixed[i] != SB_XYZ)
            l->load_nodes[l->load_count++] = i;
    }
}

static sb_vec3 regi_loads_rest_point(const regi_loads *l, int charge)
{
    int width = l->match->width;
    const int *nodes = regi_match_nodes(l->match, charge);
    sb_vec3 x = sb_v3(0, 0, 0);
    for (int a = 0; a < width; a++)
        x = sb_v3_madd(x, l->match->weights[(size_t)charge * (size_t)width + (size_t)a],
                       l->match->mesh.nodes[nodes[a]]);
    return x;
}

/* Parts around centres that are as far from each other as can be; each charge belongs to the closest. */
static void regi_loads_cut_parts(regi_loads *l)
{
    int charges = l->match->charge_count, centre = 0;
    for (int i = 0; i < charges; i++)
        l->spread[i] = SB_REAL_MAX;
    for (int s = 0; s < l->part_count; s++) {
        sb_vec3 at = regi_loads_rest_point(l, centre);
        sb_real farthest = -1;
        l->part_centre[s] = centre;
        for (int i = 0; i < charges; i++) {
            sb_vec3 way = sb_v3_sub(regi_loads_rest_point(l, i), at);
            sb_real square = sb_v3_dot(way, way);
            if (square < l->spread[i]) {
                l->spread[i] = square;
                l->part[i] = s;
            }
            if (l->spread[i] > farthest) {
                farthest = l->spread[i];
                centre = i;
            }
        }
    }
    memset(l->part_start, 0, (size_t)(l->part_count + 1) * sizeof(int));
    for (int i = 0; i < charges; i++)
        l->part_start[l->part[i] + 1]++;
    for (int s = 0; s < l->part_count; s++)
        l->part_start[s + 1] += l->part_start[s];
    for (int i = charges - 1; i >= 0; i--)
        l->part_charges[--l->part_start[l->part[i] + 1]] = i;
    /* each start has moved down to that of the part before it */
    memmove(l->part_start, l->part_start + 1, (size_t)l->part_count * sizeof(int));
    l->part_start[l->part_count] = charges;
}

/* ---- a round: samples and their responses ---- */

/* Adds weight times a charge's motion along `line` to a row. Held components do not move. */
static void regi_loads_add_point(const regi_loads *l, int charge, sb_vec3 line, sb_real weight, sb_real *row)
{
    int width = l->match->width;
    const int *nodes = regi_match_nodes(l->match, charge);
    const sb_real *weights = l->match->weights + (size_t)charge * (size_t)width;
    for (int a = 0; a < width; a++) {
        sb_real *to = row + 3 * (size_t)nodes[a], share = weight * weights[a];
        unsigned char held = l->fixed[nodes[a]];
        to[0] += held & SB_X ? 0 : share * line.x;
        to[1] += held & SB_Y ? 0 : share * line.y;
        to[2] += held & SB_Z ? 0 : share * line.z;
    }
}

/* Adds weight times a point's motion along `line` with the whole organ, and opens the gap by what that did so far. */
static void regi_loads_add_pose(regi_loads *l, int sample, sb_vec3 point, sb_vec3 line, sb_real weight)
{
    sb_vec3 turn = sb_v3_cross(sb_v3_sub(point, l->centre), line);
    const sb_real slope[REGI_LOADS_POSE] = {line.x, line.y, line.z, turn.x, turn.y, turn.z};
    sb_real *row = l->free_rows + (size_t)sample * REGI_LOADS_FREE;
    for (int k = 0; k < REGI_LOADS_POSE && l->posed; k++) {
        row[k] += weight * slope[k] * l->likely[k];
        l->gap[sample] += weight * slope[k] * l->pose[k];
    }
}

/* Signed distance of a charge from the target along the target's normal (m). */
static sb_real regi_loads_distance(const regi_match_charge *charge)
{
    return sb_v3_dot(charge->force, charge->line) / charge->stiffness;
}

/* Sums over the active charges of a part. */
typedef struct regi_loads_part {
    int count;
    sb_real area, mean, squares; /* m^2; of the distances (m), and about that (m^2) */
} regi_loads_part;

static regi_loads_part regi_loads_look_at(const regi_loads *l, int index)
{
    regi_loads_part part = {0, 0, 0, 0};
    for (int k = l->part_start[index]; k < l->part_start[index + 1]; k++) {
        const regi_match_charge *charge = l->match->charges + l->part_charges[k];
        sb_real step, distance = charge->active ? regi_loads_distance(charge) : 0;
        if (!charge->active)
            continue;
        part.count++;
        part.area += charge->area;
        step = distance - part.mean; /* weighted running mean and squares (West 1979) */
        part.mean += charge->area / part.area * step;
        part.squares += charge->area * step * (distance - part.mean);
    }
    part.squares = part.count ? part.squares / part.area * (sb_real)part.count : 0;
    return part;
}

/* What single charges scatter about the means of their parts: m^2, over all parts. */
static void regi_loads_pool(regi_loads *l)
{
    double squares = 0, freedom = 0;
    for (int s = 0; s < l->part_count; s++) {
        regi_loads_part part = regi_loads_look_at(l, s);
        squares += (double)part.squares;
        freedom += part.count > 1 ? part.count - 1 : 0;
    }
    l->scatter = (sb_real)(freedom > 0 ? squares / freedom : 0);
}

/* The mean gap along the target's normals of the charges of a part, and the row of its motion. What the gaps scatter
 * about their mean is noise that no force explains, also that of facets that cut corners: of this part and, since it
 * has few charges, of all parts. Charges share vertices with their neighbours, so that some four are worth one in the
 * mean's variance. */
static void regi_loads_sample_part(regi_loads *l, int sample, int index, sb_real *row)
{
    const int prior = 6; /* charges that the scatter of all parts counts for */
    sb_real misfit = l->def->misfit * l->match->size, scatter;
    regi_loads_part part = regi_loads_look_at(l, index);
    for (int k = l->part_start[index]; k < l->part_start[index + 1]; k++) {
        const regi_match_charge *charge = l->match->charges + l->part_charges[k];
        if (!charge->active)
            continue;
        regi_loads_add_point(l, l->part_charges[k], charge->line, charge->area / part.area, row);
        regi_loads_add_pose(l, sample, charge->point, charge->line, charge->area / part.area);
    }
    scatter = (part.squares + (sb_real)prior * l->scatter) / (sb_real)(part.count - 1 + prior);
    l->gap[sample] -= part.mean;
    l->variance[sample] = misfit * misfit * (sb_real)(l->total_area / (double)l->part_count) / part.area +
                          4 * scatter / (sb_real)part.count;
}

/* One component of a landmark's place: index counts components. */
static void regi_loads_sample_landmark(regi_loads *l, int sample, int index, sb_real *row)
{
    int axis = index % 3, charge = l->match->charge_count + index / 3;
    sb_real sd = l->def->landmark * l->match->size;
    sb_vec3 line = sb_v3(axis == 0, axis == 1, axis == 2), now = regi_match_point(l->match, charge);
    l->gap[sample] = sb_v3_dot(sb_v3_sub(l->match->targets[l->match->charges[charge].index], now), line);
    l->variance[sample] = sd * sd;
    regi_loads_add_pose(l, sample, now, line, 1);
    regi_loads_add_point(l, charge, line, 1, row);
}

/* Mean motion of a part's charges beyond that of the pose (m). */
static sb_vec3 regi_loads_part_motion(const regi_loads *l, int part)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    sb_real area = 0;
    for (int k = l->part_start[part]; k < l->part_start[part + 1]; k++) {
        int charge = l->part_charges[k];
        sb_vec3 now = regi_match_point(l->match, charge), motion = sb_v3_sub(now, regi_loads_rest_point(l, charge));
        sb_vec3 turn = sb_v3_cross(sb_v3(l->pose[3], l->pose[4], l->pose[5]), sb_v3_sub(now, l->centre));
        motion = sb_v3_sub(sb_v3_sub(motion, turn), sb_v3(l->pose[0], l->pose[1], l->pose[2]));
        sum = sb_v3_madd(sum, l->match->charges[charge].area, motion);
        area += l->match->charges[charge].area;
    }
    return sb_v3_scale(area > 0 ? 1 / area : 0, sum);
}

/* A part that is dragged does not move across the drag, but for what the drag's tilt makes of its way along it. Index
 * counts both directions across. */
static void regi_loads_sample_drag(regi_loads *l, int sample, int index, sb_real *row)
{
    int axis = index % 2, part = l->drag_parts[index / 2];
    sb_vec3 motion = regi_loads_part_motion(l, part);
    sb_real area = 0, sd;
    for (int k = l->part_start[part]; k < l->part_start[part + 1]; k++)
        area += l->match->charges[l->part_charges[k]].area;
    for (int k = l->part_start[part]; k < l->part_start[part + 1]; k++)
        regi_loads_add_point(l, l->part_charges[k], l->across[axis], l->match->charges[l->part_charges[k]].area / area,
                             row);
    sd = sb_max(l->def->drag, (sb_real)0.2 * l->drag_spread) * sb_v3_norm(motion) + l->def->misfit * l->match->size;
    l->gap[sample] = -sb_v3_dot(motion, l->across[axis]);
    l->variance[sample] = sd * sd;
    l->free_rows[(size_t)sample * REGI_LOADS_FREE + REGI_LOADS_POSE + (size_t)axis] =
        -l->likely[REGI_LOADS_POSE + axis] * sb_v3_dot(motion, l->drag);
}

/* Forces and stiffness of the present shape, factored. The mass holds what nothing holds; it acts on a round's motion
 * only, so that the end does not notice. */
static sb_result regi_loads_stiffness(regi_loads *l, sb_error *error)
{
    return sbi_body_factor(l->body, (sb_real)0.1 * l->match->young * l->match->size, l->residual, l->direct, error);
}

/* Numbers the samples of a round: parts of which something is near the target, landmarks, what is dragged. */
static void regi_loads_list_samples(regi_loads *l)
{
    int count = 0;
    for (int s = 0; s < l->part_count; s++)
        if (regi_loads_look_at(l, s).count > 0)
            l->sample_of[count++] = s;
    for (int s = l->part_count; s < l->drag_first; s++)
        l->sample_of[count++] = s;
    l->drag_sample = count;
    for (int s = 0; s < 2 * l->drag_count; s++)
        l->sample_of[count++] = l->drag_first + s;
    while (count % 3 != 0)
        l->sample_of[count++] = -1;
    l->sample_count = count;
}

static void regi_loads_sample(regi_loads *l, int sample, sb_real *row)
{
    int index = l->sample_of[sample];
    l->gap[sample] = l->variance[sample] = 0;
    if (index >= l->drag_first)
        regi_loads_sample_drag(l, sample, index - l->drag_first, row);
    else if (index >= l->part_count)
        regi_loads_sample_landmark(l, sample, index - l->part_count, row);
    else if (index >= 0)
        regi_loads_sample_part(l, sample, index, row);
}

/* Responses of the samples, a group of right-hand sides at a time, and the gaps that all the forces have to close:
 * those seen and those that would open if the present ones went. */
static void regi_loads_respond(regi_loads *l)
{
    size_t row_size = 3 * (size_t)l->node_count, samples = (size_t)l->sample_count;
    for (int first = 0; first < l->sample_count; first += SBI_FRONT_GROUP) {
        int count = sbi_min_int(SBI_FRONT_GROUP, l->sample_count - first);
        memset(l->rows, 0, (size_t)count * row_size * sizeof(sb_real));
        memset(l->free_rows + (size_t)first * REGI_LOADS_FREE, 0, (size_t)count * REGI_LOADS_FREE * sizeof(sb_real));
        for (int s = 0; s < count; s++)
            regi_loads_sample(l, first + s, l->rows + (size_t)s * row_size);
        (void)sb_direct_solve(l->direct, l->rows, l->rows, count);
        for (int s = 0; s < count; s++) {
            const sb_real *row = l->rows + (size_t)s * row_size;
            for (int i = 0; i < l->node_count; i++)
                l->gap[first + s] += sb_v3_dot(sb_v3(row[3 * i], row[3 * i + 1], row[3 * i + 2]), l->residual[i]);
            for (int k = 0; k < 3 * l->load_count; k++)
                l->response[(size_t)k * samples + (size_t)(first + s)] = row[3 * l->load_nodes[k / 3] + k % 3];
        }
    }
}

/* ---- a round: forces ---- */

/* Averages the tractions over facets and back to the nodes. */
static void regi_loads_smooth(regi_loads *l)
{
    const sb_mesh *skin = &l->boundary.surface;
    int width = sb_mesh_element_width(skin);
    memset(l->average, 0, (size_t)l->node_count * sizeof(sb_real));
    memset(l->touch, 0, (size_t)l->node_count * sizeof(sb_real));
    for (int f = 0; f < skin->element_count; f++) {
        const int *c = skin->elements + (size_t)f * (size_t)width;
        sb_real mean = 0;
        for (int k = 0; k < width; k++)
            mean += l->traction[l->boundary.nodes[c[k]]] / (sb_real)width;
        for (int k = 0; k < width; k++) {
            l->average[l->boundary.nodes[c[k]]] += mean;
            l->touch[l->boundary.nodes[c[k]]] += 1;
        }
    }
    for (int i = 0; i < l->node_count; i++)
        l->traction[i] = l->touch[i] > 0 ? l->average[i] / l->touch[i] : 0;
}

/* Largest traction (Pa). */
static sb_real regi_loads_tractions(regi_loads *l)
{
    sb_real most = 0;
    memset(l->traction, 0, (size_t)l->node_count * sizeof(sb_real));
    for (int k = 0; k < l->load_count; k++) {
        int i = l->load_nodes[k];
        l->traction[i] = sb_v3_norm(l->force[i]) / l->area[i];
        most = sb_max(most, l->traction[i]);
    }
    return most;
}

/* ---- a round: what was dragged ---- */

/* part_load; returns the largest. */
static sb_real regi_loads_load_parts(regi_loads *l)
{
    sb_real most = 0;
    int width = l->match->width;
    (void)regi_loads_tractions(l);
    for (int s = 0; s < l->part_count; s++) {
        sb_real load = 0, area = 0;
        for (int k = l->part_start[s]; k < l->part_start[s + 1]; k++) {
            const regi_match_charge *charge = l->match->charges + l->part_charges[k];
            const int *nodes = regi_match_nodes(l->match, l->part_charges[k]);
            const sb_real *weights = l->match->weights + (size_t)l->part_charges[k] * (size_t)width;
            sb_real traction = 0;
            for (int a = 0; a < width; a++)
                traction += weights[a] * l->traction[nodes[a]];
            load += charge->area * sb_max(traction, 0);
            area += charge->area;
        }
        l->part_load[s] = area > 0 ? load / area : 0;
        most = sb_max(most, l->part_load[s]);
    }
    return most;
}

/* A region is compact: parts amid dragged ones are dragged, too, and those on their own are not. */
static void regi_loads_vote(regi_loads *l)
{
    sb_real reach = (sb_real)1.6 * sb_sqrt((sb_real)(l->total_area / l->part_count));
    for (int s = 0; s < l->part_count; s++) {
        sb_vec3 at = regi_loads_rest_point(l, l->part_centre[s]), normal = l->match->charges[l->part_centre[s]].normal;
        int yes = 0, all = 0;
        for (int t = 0; t < l->part_count; t++) {
            sb_vec3 way = sb_v3_sub(regi_loads_rest_point(l, l->part_centre[t]), at);
            if (t == s || sb_v3_dot(way, way) > reach * reach ||
                sb_v3_dot(l->match->charges[l->part_centre[t]].normal, normal) < 0)
                continue;
            yes += l->is_dragged[t];
            all++;
        }
        l->votes[s] = (unsigned char)(l->is_dragged[s] ? 10 * yes >= 5 * all : all > 0 && 10 * yes >= 6 * all);
    }
    memcpy(l->is_dragged, l->votes, (size_t)l->part_count);
}

/* Parts that bear loads, and those amid them. */
static void regi_loads_choose_dragged(regi_loads *l)
{
    sb_real most = regi_loads_load_parts(l);
    for (int s = 0; s < l->part_count; s++)
        l->is_dragged[s] = l->part_load[s] > (sb_real)0.06 * most;
    for (int k = 0; k < 2; k++)
        regi_loads_vote(l);
    l->drag_count = 0;
    for (int s = 0; s < l->part_count; s++)
        if (l->is_dragged[s] && l->drag_count < l->drag_most)
            l->drag_parts[l->drag_count++] = s;
}

/* The direction that the motions of the dragged parts have most in common. */
static void regi_loads_point_drag(regi_loads *l)
{
    sb_mat3 sum = sb_m3_zero(), vectors;
    sb_vec3 values, all = sb_v3(0, 0, 0);
    for (int k = 0; k < l->drag_count; k++) {
        sb_vec3 motion = regi_loads_part_motion(l, l->drag_parts[k]);
        all = sb_v3_add(all, motion);
        sum = sb_m3_add(sum, sb_m3_outer(motion, motion));
    }
    sb_m3_eigen(sum, &values, &vectors);
    l->drag = sb_m3_column(vectors, 0);
    l->drag = sb_v3_dot(all, l->drag) < 0 ? sb_v3_scale(-1, l->drag) : l->drag;
    l->across[0] = sb_m3_column(vectors, 1);
    l->across[1] = sb_v3_cross(l->drag, l->across[0]);
    l->drag_spread = values.x > 0 ? sb_sqrt(sb_max(values.y, 0) / values.x) : 1;
}

/* 1 when the last round moved nothing by more than that share of the organ's size. */
static int regi_loads_is_at_rest(const regi_loads *l, sb_real share)
{
    return l->info.change <= share * l->match->size;
}

/* The region is decided from loads that were found without a drag, since those found with it follow what it asks for;
 * and, where all of the surface is there to contradict, once more when these come to rest. Motions that have no
 * direction in common are no drag, nor are those of a few parts. */
static void regi_loads_find_drag(regi_loads *l, int round)
{
    const sb_real most_spread = (sb_real)(1.0 / 3), rest = (sb_real)3e-3;
    int first = l->drag_looks == REGI_LOADS_LOOKS;
    if (!first && round + REGI_LOADS_AFTER >= l->def->rounds)
        l->drag_looks = 0;
    if (l->drag_looks > 0 && ((first && round >= REGI_LOADS_ALONE) || regi_loads_is_at_rest(l, rest))) {
        l->drag_looks = l->match->partial ? 0 : l->drag_looks - 1;
        regi_loads_choose_dragged(l);
    }
    if (l->drag_count > 0)
        regi_loads_point_drag(l);
    if (l->drag_spread > most_spread || (l->drag_count > 0 && l->drag_count < REGI_LOADS_LEAST))
        l->drag_count = l->drag_looks = 0;
}

/* What is least for the true loads: sum of area traction^power. */
static double regi_loads_effort(regi_loads *l)
{
    double sum = 0;
    (void)regi_loads_tractions(l);
    for (int k = 0; k < l->load_count; k++) {
        int i = l->load_nodes[k];
        if (l->traction[i] > 0)
            sum += (double)(l->area[i] * sb_exp(l->def->power * sb_log(l->traction[i])));
    }
    return sum;
}

/* 1 for a drag that asks for loads which would not be there without it: it was none, and is not looked for again. */
static int regi_loads_refuse_drag(regi_loads *l)
{
    double effort = regi_loads_effort(l);
    if (l->drag_count == 0) {
        l->effort = effort;
        return 0;
    }
    if (!(effort > 1.25 * l->effort))
        return 0;
    l->drag_count = l->drag_looks = 0;
    for (int s = l->drag_sample; s < l->sample_count; s++)
        l->variance[s] = 0;
    return 1;
}

/* w from the forces; the same everywhere when there are none yet. */
static void regi_loads_weigh(regi_loads *l)
{
    double sum = 0;
    sb_real exponent = 2 - l->def->power, mean;
    (void)regi_loads_tractions(l);
    for (int i = 0; i < l->node_count; i++)
        sum += (double)(l->area[i] * l->traction[i]);
    mean = (sb_real)(sum / l->total_area);
    for (int k = 0; k < REGI_LOADS_SMOOTH; k++)
        regi_loads_smooth(l);
    for (int k = 0; k < l->load_count; k++) {
        int i = l->load_nodes[k];
        sb_real share = mean > 0 ? l->traction[i] / mean + l->def->floor : 1;
        l->weight[k] = l->area[i] * sb_exp(exponent * sb_log(share));
    }
}

/* system = G W G^T, lower triangle, by slabs of columns for the fronts' product, which subtracts. */
static void regi_loads_gram(regi_loads *l)
{
    size_t samples = (size_t)l->sample_count, columns = 3 * (size_t)l->load_count;
    memset(l->system, 0, samples * samples * sizeof(sb_real));
    for (size_t first = 0; first < columns; first += REGI_LOADS_SLAB) {
        size_t count = columns - first < REGI_LOADS_SLAB ? columns - first : (size_t)REGI_LOADS_SLAB;
        for (size_t k = 0; k < count; k++) {
            const sb_real *from = l->response + (first + k) * samples;
            sb_real root = sb_sqrt(l->weight[(first + k) / 3]), *to = l->slab + k * (count + samples) + count;
            for (size_t s = 0; s < samples; s++)
                to[s] = root * from[s];
        }
        sbi_front_square(l->slab, count + samples, count, 0, NULL, l->system, l->pack, l->wide);
    }
}

/* Scales w so that the forces expected close gaps of the size seen, adds the variances, and turns the sign back. */
static void regi_loads_balance(regi_loads *l)
{
    size_t samples = (size_t)l->sample_count;
    double gaps = 0, trace = 0;
    sb_real scale, least;
    int count = 0;
    for (size_t s = 0; s < samples; s++)
        if (l->variance[s] > 0) {
            gaps += (double)l->gap[s] * (double)l->gap[s];
            trace -= (double)l->system[s * samples + s];
            count++;
        }
    scale = (sb_real)(trace > 0 ? gaps / trace : 0);
    least = count > 0 ? 16 * SB_EPSILON * scale * (sb_real)(trace / count) : 0; /* what its rounding takes */
    for (int k = 0; k < l->load_count; k++)
        l->weight[k] *= scale;
    for (size_t j = 0; j < samples; j++)
        for (size_t s = j; s < samples; s++) {
            sb_real *entry = l->system + j * samples + s;
            int off = !(l->variance[s] > 0 && l->variance[j] > 0);
            *entry = off ? (sb_real)(s == j) : -scale * *entry + (s == j ? l->variance[s] + least : 0);
            for (int k = 0; k < REGI_LOADS_FREE && !off; k++)
                *entry += l->free_rows[s * REGI_LOADS_FREE + (size_t)k] * l->free_rows[j * REGI_LOADS_FREE + (size_t)k];
        }
}

/* One weighted least squares problem: w, y, f. */
static sb_result regi_loads_solve(regi_loads *l, sb_error *error)
{
    size_t samples = (size_t)l->sample_count;
    sb_direct_info info;
    regi_loads_weigh(l);
    regi_loads_gram(l);
    regi_loads_balance(l);
    memset(&info, 0, sizeof info);
    for (size_t s = 0; s < samples; s++) {
        l->sizes[s] = l->system[s * samples + s];
        l->multiplier[s] = l->variance[s] > 0 ? l->gap[s] : 0;
    }
    if (sbi_front_factor(l->system, samples, samples, 0, l->signs, l->sizes, l->pack, l->wide, &info) >= 0)
        return sbi_fail(error, SB_ERROR_INDEFINITE, "the samples of the surface cannot be told apart");
    sbi_front_forward(l->system, samples, samples, l->multiplier, 1, l->wide);
    sbi_front_backward(l->system, samples, samples, l->multiplier, 1, l->wide);
    for (int k = 0; k < l->load_count; k++) {
        sb_real sum[3] = {0, 0, 0};
        for (int axis = 0; axis < 3; axis++) {
            const sb_real *row = l->response + (3 * (size_t)k + (size_t)axis) * samples;
            for (size_t s = 0; s < samples; s++)
                sum[axis] += row[s] * l->multiplier[s];
        }
        l->force[l->load_nodes[k]] = sb_v3_scale(l->weight[k], sb_v3(sum[0], sum[1], sum[2]));
    }
    for (int k = 0; k < REGI_LOADS_POSE; k++) {
        l->next[k] = 0;
        for (size_t s = 0; s < samples && l->posed; s++)
            l->next[k] += l->likely[k] * l->free_rows[s * REGI_LOADS_FREE + (size_t)k] * l->multiplier[s];
    }
    return SB_OK;
}

static sb_result regi_loads_reweight(regi_loads *l, int times, sb_error *error)
{
    sb_result result = SB_OK;
    for (int k = 0; result == SB_OK && k < times; k++)
        result = regi_loads_solve(l, error);
    return result;
}

/* What the solution leaves of the gaps of the surface: variance times y. */
static sb_real regi_loads_misfit(const regi_loads *l)
{
    double sum = 0;
    int count = 0;
    for (int s = 0; s < l->drag_sample; s++)
        if (l->sample_of[s] < l->part_count && l->variance[s] > 0) {
            double left = (double)(l->variance[s] * l->multiplier[s]);
            sum += left * left;
            count++;
        }
    return (sb_real)(count > 0 ? sb_sqrt((sb_real)(sum / count)) : 0);
}

/* Adds what is new of the pose to the increment. */
static void regi_loads_turn(regi_loads *l)
{
    sb_real d[REGI_LOADS_POSE];
    sb_vec3 way;
    sb_mat3 rotation;
    for (int k = 0; k < REGI_LOADS_POSE; k++)
        d[k] = l->next[k] - l->pose[k];
    way = sb_v3_add(l->centre, sb_v3(d[0], d[1], d[2]));
    rotation = sb_quat_to_mat3(sb_quat_from_rotation_vector(sb_v3(d[3], d[4], d[5])));
    for (int i = 0; i < l->node_count; i++) {
        sb_vec3 x = sb_body_positions(l->body)[i], turned = sb_m3_apply(rotation, sb_v3_sub(x, l->centre));
        sb_vec3 step = sb_m3_apply(rotation, l->increment[i]);
        l->increment[i] = sb_v3_add(step, sb_v3_sub(sb_v3_add(turned, way), x));
    }
}

/* Sends held nodes to displacements[nodes]. */
static void regi_loads_hold(regi_loads *l, const sb_vec3 *displacements)
{
    for (int axes = 1; axes <= SB_XYZ; axes++) {
        int count = 0;
        for (int i = 0; i < l->node_count; i++)
            if (l->fixed[i] == axes) {
                l->held_nodes[count] = i;
                l->held_goals[count++] = displacements[i];
            }
        if (count > 0)
            (void)sb_body_prescribe(l->body, l->held_nodes, count, axes, l->held_goals, 0);
    }
}

/* The increment is taken, and the body's supports go along with the pose. */
static sb_result regi_loads_move(regi_loads *l, sb_error *error)
{
    sb_real planned = 0, share;
    sb_result result;
    if (l->posed)
        regi_loads_turn(l);
    for (int i = 0; i < l->node_count; i++)
        planned = sb_max(planned, sb_v3_norm(l->increment[i]));
    result = regi_match_shorten(l->match, l->increment);
    if (result != SB_OK) {
        if (error)
            *error = l->match->info.error;
        return result;
    }
    sbi_body_place(l->body, l->match->trial);
    l->info.change = l->match->info.change;
    share = planned > 0 ? l->info.change / planned : 1;
    for (int k = 0; k < REGI_LOADS_POSE; k++)
        l->pose[k] += share * (l->next[k] - l->pose[k]);
    if (l->posed)
        regi_loads_hold(l, sb_body_displacements(l->body));
    return SB_OK;
}

static sb_result regi_loads_round(regi_loads *l, int round, sb_error *error)
{
    double begin = regi_loads_now(l), responded;
    int reweights = round == 0 ? l->def->reweights : (l->def->reweights + 2) / 3;
    sb_result result;
    (void)regi_match_look(l->match);
    l->info.mean_distance = l->match->info.mean_distance;
    if (!(l->match->info.active > 0))
        return sbi_fail(error, SB_ERROR_NOT_CONVERGED, "nothing of the organ's surface is near the target");
    result = regi_loads_stiffness(l, error);
    if (result != SB_OK)
        return result;
    regi_loads_pool(l);
    regi_loads_find_drag(l, round);
    regi_loads_list_samples(l);
    regi_loads_respond(l);
    responded = regi_loads_now(l);
    l->info.seconds_response += responded - begin;
    result = regi_loads_reweight(l, reweights, error);
    if (result == SB_OK && regi_loads_refuse_drag(l))
        result = regi_loads_reweight(l, reweights, error);
    l->info.seconds_dense += regi_loads_now(l) - responded;
    if (result != SB_OK)
        return result;
    for (int i = 0; i < l->node_count; i++)
        l->increment[i] = sbi_body_pick_axes(l->fixed[i], sb_v3(0, 0, 0), sb_v3_sub(l->force[i], l->residual[i]));
    (void)sb_direct_solve(l->direct, &l->increment[0].x, &l->increment[0].x, 1);
    l->info.sample_misfit = regi_loads_misfit(l);
    result = regi_loads_move(l, error);
    l->info.rounds += result == SB_OK;
    return result;
}

/* ---- life ---- */

static void regi_loads_layout(regi_loads *l, sbi_arena *arena)
{
    size_t n = (size_t)l->node_count, charges = (size_t)l->match->charge_count, samples = (size_t)l->sample_most;
    size_t skin = (size_t)l->boundary.surface.node_count, real = sizeof(sb_real);
    l->load_nodes = (int *)sbi_arena_take(arena, skin, sizeof(int));
    l->sample_of = (int *)sbi_arena_take(arena, samples, sizeof(int));
    l->area = (sb_real *)sbi_arena_take(arena, n, real);
    l->part = (int *)sbi_arena_take(arena, charges, sizeof(int));
    l->part_start = (int *)sbi_arena_take(arena, (size_t)l->part_count + 1, sizeof(int));
    l->part_charges = (int *)sbi_arena_take(arena, charges, sizeof(int));
    l->part_centre = (int *)sbi_arena_take(arena, (size_t)l->part_count, sizeof(int));
    l->part_load = (sb_real *)sbi_arena_take(arena, (size_t)l->part_count, real);
    l->is_dragged = (unsigned char *)sbi_arena_take(arena, (size_t)l->part_count, 1);
    l->votes = (unsigned char *)sbi_arena_take(arena, (size_t)l->part_count, 1);
    l->drag_parts = (int *)sbi_arena_take(arena, (size_t)l->part_count, sizeof(int));
    l->spread = (sb_real *)sbi_arena_take(arena, charges, real);
    l->rows = (sb_real *)sbi_arena_take(arena, n, 3 * SBI_FRONT_GROUP * real);
    l->response = (sb_real *)sbi_arena_take(arena, skin, 3 * samples * real);
    l->gap = (sb_real *)sbi_arena_take(arena, samples, real);
    l->variance = (sb_real *)sbi_arena_take(arena, samples, real);
    l->system = (sb_real *)sbi_arena_take(arena, samples, samples * real);
    l->multiplier = (sb_real *)sbi_arena_take(arena, samples, real);
    l->signs = (sb_real *)sbi_arena_take(arena, samples, real);
    l->sizes = (sb_real *)sbi_arena_take(arena, samples, real);
    l->slab = (sb_real *)sbi_arena_take(arena, REGI_LOADS_SLAB + samples, REGI_LOADS_SLAB * real);
    l->pack = (sb_real *)sbi_arena_take(arena, SBI_FRONT_PACK, real);
    l->weight = (sb_real *)sbi_arena_take(arena, skin, real);
    l->traction = (sb_real *)sbi_arena_take(arena, n, real);
    l->average = (sb_real *)sbi_arena_take(arena, n, real);
    l->touch = (sb_real *)sbi_arena_take(arena, n, real);
    l->force = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    l->residual = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    l->increment = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    l->held_nodes = (int *)sbi_arena_take(arena, n, sizeof(int));
    l->held_goals = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    l->before = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    l->goals = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    l->free_rows = (sb_real *)sbi_arena_take(arena, samples, REGI_LOADS_FREE * real);
}

/* A turn moves points at a quarter of the organ's size as far as a move does. */
static void regi_loads_begin_pose(regi_loads *l)
{
    int held = 0, count = 0;
    for (int i = 0; i < l->node_count; i++)
        held += l->fixed[i] == SB_XYZ;
    l->posed = l->def->pose > 0;
    for (int i = 0; i < l->node_count; i++)
        if (held == 0 || l->fixed[i] == SB_XYZ)
            l->centre =
                sb_v3_madd(l->centre, 1 / (sb_real)++count, sb_v3_sub(sb_body_positions(l->body)[i], l->centre));
    for (int k = 0; k < REGI_LOADS_POSE; k++)
        l->likely[k] = l->def->pose * (k < 3 ? l->match->size : 4);
    for (int k = REGI_LOADS_POSE; k < REGI_LOADS_FREE; k++)
        l->likely[k] = (sb_real)0.3;
}

/* As many parts as make the samples asked for where the target shows a part of the organ, but at most twice as many. */
static int regi_loads_part_count(const regi_loads *l)
{
    double all = 0, seen = 0, times = 1;
    for (int i = 0; i < l->match->charge_count; i++) {
        all += (double)l->match->charges[i].area;
        seen += l->match->charges[i].active ? (double)l->match->charges[i].area : 0;
    }
    if (l->match->partial)
        times = all < 2 * seen ? all / seen : 2;
    return sbi_min_int((int)(times * l->def->samples), l->match->charge_count);
}

static sb_result regi_loads_prepare(regi_loads *l, sb_error *error)
{
    const sb_allocator *allocator = &l->def->allocator;
    sb_mesh mesh = l->match->mesh;
    sbi_arena arena;
    regi_pieces pieces;
    sb_result result = regi_pieces_make(l->body, &mesh, allocator, &pieces, error);
    if (result == SB_OK)
        result = regi_pieces_skin(&pieces, NULL, &l->boundary, error);
    regi_pieces_free(&pieces);
    if (result == SB_OK)
        result = sbi_body_make_factor(l->body, allocator, &l->direct, error);
    if (result != SB_OK)
        return result;
    l->node_count = mesh.node_count;
    l->wide = sbi_lanes_are_wide();
    l->part_count = regi_loads_part_count(l);
    l->drag_first = l->part_count + 3 * l->match->landmark_count;
    l->drag_most = l->def->drag > 0 ? l->part_count / 3 : 0;
    l->drag_looks = l->drag_most > 0 ? REGI_LOADS_LOOKS : 0;
    l->sample_most = (l->drag_first + 2 * l->drag_most + 2) / 3 * 3;
    memset(&arena, 0, sizeof arena);
    regi_loads_layout(l, &arena);
    l->memory = arena.overflow ? NULL : sbi_alloc_zeroed(allocator, 1, arena.used);
    if (!l->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d samples of the surface", l->sample_most);
    arena.base = (unsigned char *)l->memory;
    arena.used = 0;
    regi_loads_layout(l, &arena);
    memcpy(l->before, sb_body_displacements(l->body), (size_t)l->node_count * sizeof(sb_vec3));
    memcpy(l->goals, sbi_body_targets(l->body), (size_t)l->node_count * sizeof(sb_vec3));
    regi_loads_begin_pose(l);
    regi_loads_measure_nodes(l);
    regi_loads_cut_parts(l);
    return l->load_count > 0 ? SB_OK : sbi_fail(error, SB_ERROR_ARGUMENT, "all of the surface is held");
}

/* 1 when there is no time for a round that takes as long as those before, or a first one. */
static int regi_loads_is_late(const regi_loads *l)
{
    double spent = l->def->clock ? l->def->clock() - l->begun : 0;
    double round = l->info.rounds ? (l->info.seconds_response + l->info.seconds_dense) / l->info.rounds : 0;
    return l->def->clock && spent + round >= l->def->max_seconds;
}

/* Rounds, and what they found; a failure puts the body back. */
static sb_result regi_loads_find(regi_loads *l, sb_vec3 *forces, sb_error *error)
{
    sb_result result = regi_loads_prepare(l, error);
    double loaded = 0;
    sb_real most;
    if (result != SB_OK)
        return result;
    l->info.change = l->match->size;
    for (int round = 0; result == SB_OK && round < l->def->rounds; round++)
        if ((l->drag_looks > 0 || !regi_loads_is_at_rest(l, (sb_real)1e-3)) && !regi_loads_is_late(l))
            result = regi_loads_round(l, round, error);
    if (result != SB_OK) {
        sbi_body_place(l->body, l->before);
        if (l->posed)
            regi_loads_hold(l, l->goals);
        return result;
    }
    most = regi_loads_tractions(l);
    for (int i = 0; i < l->node_count; i++)
        loaded += l->traction[i] > (sb_real)0.05 * most ? (double)l->area[i] : 0;
    l->info.loaded = (sb_real)(loaded / l->total_area);
    l->info.drag = l->drag_count > 0 ? l->drag : sb_v3(0, 0, 0);
    if (forces)
        memcpy(forces, l->force, (size_t)l->node_count * sizeof(sb_vec3));
    return SB_OK;
}

REG_API sb_result reg_loads_run(const reg_loads_def *def, sb_vec3 *forces, reg_loads_info *info)
{
    regi_loads loads;
    sb_result result;
    memset(&loads, 0, sizeof loads);
    loads.info.error.element = loads.info.error.node = -1;
    result = regi_loads_check(def, &loads.info.error);
    if (result == SB_OK) {
        loads.def = def;
        loads.match = def->match;
        loads.body = def->match->body;
        loads.fixed = sb_body_supports(loads.body);
        loads.begun = regi_loads_now(&loads);
        result = regi_loads_find(&loads, forces, &loads.info.error);
        loads.info.seconds = regi_loads_now(&loads) - loads.begun;
        sb_boundary_free(&loads.boundary);
        sb_direct_free(loads.direct);
        sbi_free(&def->allocator, loads.memory);
    }
    if (info)
        *info = loads.info;
    return result;
}

/* ==== src/register/chance.h ==== */
/* chance: normal numbers, the same everywhere. Floor 6, internal. */
#ifndef REGI_CHANCE_H
#define REGI_CHANCE_H


/* State of a generator: {a seed but 0, 0, 0}. */
typedef struct regi_chance {
    uint64_t state;
    double spare;
    int has_spare;
} regi_chance;

/* The next number of mean 0 and deviation 1. */
REGI_API double regi_chance_normal(regi_chance *chance);

#endif /* REGI_CHANCE_H */

/* ==== src/register/chance.c ==== */
/* chance: see chance.h. */

#include <math.h>


/* In (-1, 1): xorshift64*. */
static double regi_chance_uniform(regi_chance *chance)
{
    chance->state ^= chance->state >> 12;
    chance->state ^= chance->state << 25;
    chance->state ^= chance->state >> 27;
    return (double)((chance->state * 2685821657736338717u) >> 11) / 4503599627370496.0 - 1;
}

/* By Marsaglia's polar method. */
REGI_API double regi_chance_normal(regi_chance *chance)
{
    double u, v, square;
    if (chance->has_spare) {
        chance->has_spare = 0;
        return chance->spare;
    }
    do {
        u = regi_chance_uniform(chance);
        v = regi_chance_uniform(chance);
        square = u * u + v * v;
    } while (!(square > 0) || square >= 1);
    square = sqrt(-2 * sbi_dense_log(square) / square);
    chance->spare = v * square;
    chance->has_spare = 1;
    return u * square;
}

/* ==== src/register/block.h ==== */
/* block: products of dense matrices of doubles, in tiles that the registers hold. Floor 6, internal.
 *
 * Each sum runs over the depth in ascending order and is then added: the same bits whatever the vectors' width. */
#ifndef REGI_BLOCK_H
#define REGI_BLOCK_H


/* Sums over `depth` of products of left[k left_stride + i] and right[k right_step + j right_stride]. */
typedef struct regi_block {
    const double *left, *right;
    size_t left_stride, right_step, right_stride;
    int depth;
    int wide; /* what sbi_lanes_are_wide() said */
} regi_block;

enum {
    REGI_BLOCK_ROWS = 4, /* j of a tile, */
    REGI_BLOCK_WIDTH = 8 /* and i */
};

/* to[j stride + i] += factor * the sums, i < width, j < rows. */
REGI_API void regi_block_add(const regi_block *block, int width, int rows, double factor, double *to, size_t stride);
/* x[n][REGI_BLOCK_WIDTH] <- U^-T x for the upper u[n][stride]. */
REGI_API void regi_block_forward(int wide, const double *u, int n, size_t stride, double *x);
/* x[n][REGI_BLOCK_WIDTH] <- U^-1 x */
REGI_API void regi_block_backward(int wide, const double *u, int n, size_t stride, double *x);

#endif /* REGI_BLOCK_H */

/* ==== src/register/block.c ==== */
/* block: see block.h. */

#include <string.h>

#if defined(__GNUC__) && !defined(SB_NO_VECTORS)
typedef double regi_block_pair_lanes __attribute__((vector_size(16), aligned(sizeof(double)), may_alias));
typedef double regi_block_quad_lanes __attribute__((vector_size(32), aligned(sizeof(double)), may_alias));
#define REGI_BLOCK_AT(lanes, pointer) (*(const lanes *)(const void *)(pointer))
#define REGI_BLOCK_PUT(lanes, pointer, value) (*(lanes *)(void *)(pointer) = (value))

/* tile[4][8]: the sums of i and j on, for a type of vectors: two of them at a time, as many as the registers hold. */
#define REGI_BLOCK_TILE(kind, lanes)                                                                                   \
    SBI_FORCE_INLINE void regi_block_tile_##kind(const regi_block *b, int i, int j, double *tile)                      \
    {                                                                                                                  \
        enum { WIDTH = (int)(sizeof(lanes) / sizeof(double)) };                                                        \
        for (int part = 0; part < REGI_BLOCK_WIDTH; part += 2 * WIDTH) {                                               \
            const double *left = b->left + i + part, *r0 = b->right + (size_t)j * b->right_stride;                     \
            const double *r1 = r0 + b->right_stride, *r2 = r1 + b->right_stride, *r3 = r2 + b->right_stride;           \
            double *to = tile + part;                                                                                  \
            lanes c00 = {0}, c01 = c00, c10 = c00, c11 = c00, c20 = c00, c21 = c00, c30 = c00, c31 = c00;              \
            size_t step = b->right_step;                                                                               \
            for (int k = 0; k < b->depth; k++, left += b->left_stride) {                                               \
                lanes x = REGI_BLOCK_AT(lanes, left), y = REGI_BLOCK_AT(lanes, left + WIDTH);                          \
                c00 += x * *r0, c01 += y * *r0, r0 += step;                                                            \
                c10 += x * *r1, c11 += y * *r1, r1 += step;                                                            \
                c20 += x * *r2, c21 += y * *r2, r2 += step;                                                            \
                c30 += x * *r3, c31 += y * *r3, r3 += step;                                                            \
            }                                                                                                          \
            REGI_BLOCK_PUT(lanes, to, c00), REGI_BLOCK_PUT(lanes, to + WIDTH, c01), to += REGI_BLOCK_WIDTH;            \
            REGI_BLOCK_PUT(lanes, to, c10), REGI_BLOCK_PUT(lanes, to + WIDTH, c11), to += REGI_BLOCK_WIDTH;            \
            REGI_BLOCK_PUT(lanes, to, c20), REGI_BLOCK_PUT(lanes, to + WIDTH, c21), to += REGI_BLOCK_WIDTH;            \
            REGI_BLOCK_PUT(lanes, to, c30), REGI_BLOCK_PUT(lanes, to + WIDTH, c31);                                    \
        }                                                                                                              \
    }

#if defined(__AVX__) || SBI_IS_WIDENED
REGI_BLOCK_TILE(quads, regi_block_quad_lanes)
#endif
#if !defined(__AVX__)
REGI_BLOCK_TILE(pairs, regi_block_pair_lanes)
#endif

SBI_FORCE_INLINE void regi_block_tile(int wide, const regi_block *b, int i, int j, double *tile)
{
#if defined(__AVX__)
    (void)wide;
    regi_block_tile_quads(b, i, j, tile);
#elif SBI_IS_WIDENED
    if (wide)
        regi_block_tile_quads(b, i, j, tile);
    else
        regi_block_tile_pairs(b, i, j, tile);
#else
    (void)wide;
    regi_block_tile_pairs(b, i, j, tile);
#endif
}
#else
SBI_FORCE_INLINE void regi_block_tile(int wide, const regi_block *b, int i, int j, double *tile)
{
    (void)wide;
    memset(tile, 0, REGI_BLOCK_ROWS * REGI_BLOCK_WIDTH * sizeof *tile);
    for (int k = 0; k < b->depth; k++)
        for (int r = 0; r < REGI_BLOCK_ROWS; r++) {
            double right = b->right[(size_t)k * b->right_step + (size_t)(j + r) * b->right_stride];
            const double *left = b->left + (size_t)k * b->left_stride + i;
            for (int c = 0; c < REGI_BLOCK_WIDTH; c++)
                tile[r * REGI_BLOCK_WIDTH + c] += left[c] * right;
        }
}
#endif

/* tile[8][8], two tiles: as vectors of eight they are one to a row, and eight sums hide how long an addition takes. */
#if defined(__GNUC__) && !defined(SB_NO_VECTORS) && defined(__AVX512F__)
typedef double regi_block_row __attribute__((vector_size(64), aligned(sizeof(double)), may_alias));

SBI_FORCE_INLINE void regi_block_pair(int wide, const regi_block *b, int i, int j, double *tile)
{
    const double *left = b->left + i, *r0 = b->right + (size_t)j * b->right_stride, *r4 = r0 + 4 * b->right_stride;
    size_t one = b->right_stride, two = 2 * one, three = 3 * one;
    regi_block_row c0 = {0}, c1 = c0, c2 = c0, c3 = c0, c4 = c0, c5 = c0, c6 = c0, c7 = c0, *to;
    for (int k = 0; k < b->depth; k++, left += b->left_stride, r0 += b->right_step, r4 += b->right_step) {
        regi_block_row x = *(const regi_block_row *)(const void *)left;
        c0 += x * r0[0], c1 += x * r0[one], c2 += x * r0[two], c3 += x * r0[three];
        c4 += x * r4[0], c5 += x * r4[one], c6 += x * r4[two], c7 += x * r4[three];
    }
    (void)wide;
    to = (regi_block_row *)(void *)tile;
    to[0] = c0, to[1] = c1, to[2] = c2, to[3] = c3, to[4] = c4, to[5] = c5, to[6] = c6, to[7] = c7;
}
#else
SBI_FORCE_INLINE void regi_block_pair(int wide, const regi_block *b, int i, int j, double *tile)
{
    regi_block_tile(wide, b, i, j, tile);
    regi_block_tile(wide, b, i, j + REGI_BLOCK_ROWS, tile + REGI_BLOCK_ROWS * REGI_BLOCK_WIDTH);
}
#endif

/* The sums of i, j on that do not fill a tile. */
SBI_FORCE_INLINE void regi_block_rest(const regi_block *b, int i, int width, int j, int rows, double *tile)
{
    memset(tile, 0, (size_t)(rows * REGI_BLOCK_WIDTH) * sizeof *tile);
    for (int k = 0; k < b->depth; k++)
        for (int r = 0; r < rows; r++) {
            double right = b->right[(size_t)k * b->right_step + (size_t)(j + r) * b->right_stride];
            const double *left = b->left + (size_t)k * b->left_stride + i;
            for (int c = 0; c < width; c++)
                tile[r * REGI_BLOCK_WIDTH + c] += left[c] * right;
        }
}

SBI_FORCE_INLINE void regi_block_add_any_lanes(int wide, const regi_block *b, int width, int rows, double factor,
                                               double *to, size_t stride)
{
    double tile[2 * (int)REGI_BLOCK_ROWS * (int)REGI_BLOCK_WIDTH];
    for (int j = 0, high; j < rows; j += high) {
        high = rows - j < 2 * REGI_BLOCK_ROWS ? sbi_min_int(REGI_BLOCK_ROWS, rows - j) : 2 * REGI_BLOCK_ROWS;
        for (int i = 0; i < width; i += REGI_BLOCK_WIDTH) {
            int have = sbi_min_int(REGI_BLOCK_WIDTH, width - i);
            if (high > REGI_BLOCK_ROWS && have == REGI_BLOCK_WIDTH)
                regi_block_pair(wide, b, i, j, tile);
            else if (high == REGI_BLOCK_ROWS && have == REGI_BLOCK_WIDTH)
                regi_block_tile(wide, b, i, j, tile);
            else
                regi_block_rest(b, i, have, j, high, tile);
            for (int r = 0; r < high; r++)
                for (int c = 0; c < have; c++)
                    to[(size_t)(j + r) * stride + (size_t)(i + c)] += factor * tile[r * REGI_BLOCK_WIDTH + c];
        }
    }
}

SBI_WIDEN_IF(regi_block_add_any, (const regi_block *b, int width, int rows, double factor, double *to, size_t stride),
             (b, width, rows, factor, to, stride))

REGI_API void regi_block_add(const regi_block *b, int width, int rows, double factor, double *to, size_t stride)
{
    regi_block_add_any(b->wide, b, width, rows, factor, to, stride);
}

REGI_API void regi_block_forward(int wide, const double *u, int n, size_t stride, double *x)
{
    for (int first = 0; first < n; first += REGI_BLOCK_ROWS) {
        int rows = sbi_min_int(REGI_BLOCK_ROWS, n - first);
        regi_block before = {x, u + first, REGI_BLOCK_WIDTH, 0, 1, 0, 0};
        before.wide = wide;
        before.right_step = stride;
        before.depth = first;
        regi_block_add(&before, REGI_BLOCK_WIDTH, rows, -1, x + (size_t)first * REGI_BLOCK_WIDTH, REGI_BLOCK_WIDTH);
        for (int k = first; k < first + rows; k++)
            for (int c = 0; c < REGI_BLOCK_WIDTH; c++) {
                double *at = x + (size_t)k * REGI_BLOCK_WIDTH + c;
                *at /= u[(size_t)k * stride + (size_t)k];
                for (int r = k + 1; r < first + rows; r++)
                    x[(size_t)r * REGI_BLOCK_WIDTH + (size_t)c] -= u[(size_t)k * stride + (size_t)r] * *at;
            }
    }
}

REGI_API void regi_block_backward(int wide, const double *u, int n, size_t stride, double *x)
{
    for (int first = (n - 1) / REGI_BLOCK_ROWS * REGI_BLOCK_ROWS; first >= 0; first -= REGI_BLOCK_ROWS) {
        int next = sbi_min_int(first + REGI_BLOCK_ROWS, n);
        regi_block after = {x + (size_t)next * REGI_BLOCK_WIDTH, NULL, REGI_BLOCK_WIDTH, 1, 0, 0, 0};
        after.wide = wide;
        after.right = u + (size_t)first * stride + (size_t)next;
        after.right_stride = stride;
        after.depth = n - next;
        regi_block_add(&after, REGI_BLOCK_WIDTH, next - first, -1, x + (size_t)first * REGI_BLOCK_WIDTH,
                       REGI_BLOCK_WIDTH);
        for (int k = next - 1; k >= first; k--)
            for (int c = 0; c < REGI_BLOCK_WIDTH; c++) {
                double *at = x + (size_t)k * REGI_BLOCK_WIDTH + c;
                for (int r = k + 1; r < next; r++)
                    *at -= u[(size_t)k * stride + (size_t)r] * x[(size_t)r * REGI_BLOCK_WIDTH + (size_t)c];
                *at /= u[(size_t)k * stride + (size_t)k];
            }
    }
}

/* ==== src/register/gauss.h ==== */
/* gauss: the linear Gaussian model behind an inference: data that loads and a pose explain. Floor 6, internal.
 *
 *     gap = V c + R p + noise,   c ~ N(0, scale^2 I) with B c = 0,   p ~ N(0, I),   noise ~ N(0, diag(variance))
 * Each of the m gaps is a datum; a column of V is what a unit of one load does to all data, B are resultants that loads
 * must not have. The posterior is found in the data (m x m), whatever the number of loads:
 *     S = scale^2 V V^T + R R^T + diag(variance),   y = S^-1 gap,   c = scale^2 V^T y,   p = R^T y.
 * It knows nothing of meshes. Everything is in double, in one order: the same bits everywhere. */
#ifndef REGI_GAUSS_H
#define REGI_GAUSS_H


enum {
    REGI_GAUSS_POSES = 7, /* most columns of R, */
    REGI_GAUSS_EXACT = 6, /* rows of B, */
    REGI_GAUSS_RANK = 96, /* and directions of the data that the evidence is found in */
    REGI_GAUSS_WIDTH = REGI_GAUSS_POSES + REGI_GAUSS_RANK + 1
};

typedef struct regi_gauss {
    int most, most_loads; /* room for data and loads */
    int count, loads;     /* m and the columns of V */
    int poses, exact;     /* columns of R; rows of B, or 0 */
    int wide;             /* what sbi_lanes_are_wide() said */
    double scale;         /* sd of a load */
    double *columns;      /* [loads][most] V^T */
    double *resultants;   /* [exact][most_loads] B; orthonormal once bound */
    double *pose;         /* [poses][most] R^T */
    double *gap;          /* [count] */
    double *variance;     /* [count], >= 0; 0: met exactly */
    double *gram;         /* [count][most] V V^T, upper triangle */
    double *system;       /* [count][most] U of S = U^T U */
    double *multiplier;   /* [count] y */
    /* of the evidence */
    int rank;               /* directions found */
    double *low;            /* [RANK][most] V V^T = low^T low */
    double *small;          /* [RANK][RANK] */
    double *diagonal;       /* [RANK] and neighbours, [RANK - 1], of low Sigma^-1 low^T made tridiagonal, */
    double *beside, *along; /* and low Sigma^-1 gap [RANK] turned along with it */
    double *scratch;        /* [most + 2 RANK] */
    double *weighted;       /* [most][WIDTH] of data: pose, low and gap over their deviations, */
    double *products;       /* [WIDTH][WIDTH] and products of these columns */
    double rigid_misfit;    /* gap^T Sigma^-1 gap, Sigma = R R^T + diag(variance) */
    double rigid_volume;    /* log |Sigma| */
    void *memory;
    sb_allocator allocator;
} regi_gauss;

/* Room for so many data and loads. SB_ERROR_MEMORY. */
REGI_API sb_result regi_gauss_create(int most, int most_loads, const sb_allocator *allocator, regi_gauss *gauss,
                                     sb_error *error);
REGI_API void regi_gauss_free(regi_gauss *gauss); /* zeros are fine */

/* Takes out of V what of the loads has resultants: V <- V (I - B^+ B). */
REGI_API void regi_gauss_bind(regi_gauss *gauss);
/* Takes the resultants out of loads c[loads]. */
REGI_API void regi_gauss_balance(const regi_gauss *gauss, double *c);
/* gram = V V^T. */
REGI_API void regi_gauss_multiply(regi_gauss *gauss);

/* ---- the posterior of the present scale and variances; gram is there ---- */
/* S and y. 0: S is not positive. */
REGI_API int regi_gauss_solve(regi_gauss *gauss);
/* r[count] <- S^-1 r. */
REGI_API void regi_gauss_apply_inverse(const regi_gauss *gauss, double *r);
/* r <- U^-T r: of length |r|^2 = r^T S^-1 r. */
REGI_API void regi_gauss_whiten(const regi_gauss *gauss, double *r);
/* The same for x[count][REGI_BLOCK_WIDTH], as many at once. */
REGI_API void regi_gauss_whiten_many(const regi_gauss *gauss, double *x);
/* c[loads], p[poses] that multipliers y[count] stand for. */
REGI_API void regi_gauss_explain(const regi_gauss *gauss, const double *y, double *c, double *p);
/* out[count] = V c + R p. */
REGI_API void regi_gauss_predict(const regi_gauss *gauss, const double *c, const double *p, double *out);
/* Turns draws of the prior c[loads] (balanced), p[poses] and of the data's noise e[count], which is overwritten, into
 * a draw of the posterior's errors (Matheron's rule). */
REGI_API void regi_gauss_condition(const regi_gauss *gauss, double *c, double *p, double *e);

/* ---- evidence; gram is there ---- */
/* low: the pivoted Cholesky factor of gram. */
REGI_API void regi_gauss_reduce(regi_gauss *gauss);
/* Makes low tridiagonal against the noise and pose of now. 0: it has none (something is not finite). */
REGI_API int regi_gauss_spectrum(regi_gauss *gauss);
/* log p(gap | scale), less a constant of the count; scale 0: no loads at all. */
REGI_API double regi_gauss_evidence(const regi_gauss *gauss, double scale);
/* The scale of a grid (67 values, a tenth of a decade apart, about what the gaps and gram suggest) with the most
 * evidence, and that. */
REGI_API double regi_gauss_best_scale(const regi_gauss *gauss, double *evidence);

/* ---- dense helpers; wide: what sbi_lanes_are_wide() said ---- */
/* Upper triangle of upper[n][stride] += rows^T rows of rows[count][stride]. */
REGI_API void regi_gauss_add_squares(int wide, double *upper, int n, const double *rows, int count, size_t stride);
/* Upper a[n][stride] = U^T U in place, rows below the diagonal untouched. Returns 0 at a pivot that is not positive. */
REGI_API int regi_gauss_cholesky(int wide, double *a, int n, size_t stride);
/* r[n] <- U^-1 U^-T r */
REGI_API void regi_gauss_substitute(const double *u, int n, size_t stride, double *r);

#endif /* REGI_GAUSS_H */

/* ==== src/register/gauss.c ==== */
/* gauss: see gauss.h. Inner loops add one row to another where they can, so that they need no reordering of sums to be
 * fast. */

#include <math.h>
#include <string.h>


enum { REGI_GAUSS_SCALES = 67 }; /* of the grid */

static void regi_gauss_layout(regi_gauss *g, sbi_arena *arena)
{
    size_t m = (size_t)g->most, real = sizeof(double), rank = REGI_GAUSS_RANK;
    g->columns = (double *)sbi_arena_take(arena, (size_t)g->most_loads, m * real);
    g->resultants = (double *)sbi_arena_take(arena, (size_t)g->most_loads, REGI_GAUSS_EXACT * real);
    g->pose = (double *)sbi_arena_take(arena, m, REGI_GAUSS_POSES * real);
    g->gap = (double *)sbi_arena_take(arena, m, real);
    g->variance = (double *)sbi_arena_take(arena, m, real);
    g->gram = (double *)sbi_arena_take(arena, m, m * real);
    g->system = (double *)sbi_arena_take(arena, m, m * real);
    g->multiplier = (double *)sbi_arena_take(arena, m, real);
    g->low = (double *)sbi_arena_take(arena, m, rank * real);
    g->small = (double *)sbi_arena_take(arena, rank, rank * real);
    g->diagonal = (double *)sbi_arena_take(arena, rank, real);
    g->beside = (double *)sbi_arena_take(arena, rank, real);
    g->along = (double *)sbi_arena_take(arena, rank, real);
    g->scratch = (double *)sbi_arena_take(arena, m + 2 * rank, real);
    g->weighted = (double *)sbi_arena_take(arena, m, REGI_GAUSS_WIDTH * real);
    g->products = (double *)sbi_arena_take(arena, REGI_GAUSS_WIDTH, REGI_GAUSS_WIDTH * real);
}

REGI_API sb_result regi_gauss_create(int most, int most_loads, const sb_allocator *allocator, regi_gauss *gauss,
                                     sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    regi_gauss g;
    memset(&g, 0, sizeof g);
    g.most = most;
    g.most_loads = most_loads;
    g.wide = sbi_lanes_are_wide();
    if (allocator)
        g.allocator = *allocator;
    regi_gauss_layout(&g, &arena);
    g.memory = arena.overflow ? NULL : sbi_alloc_zeroed(&g.allocator, 1, arena.used);
    if (!g.memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d data of %d loads", most, most_loads);
    arena.base = (unsigned char *)g.memory;
    arena.used = 0;
    regi_gauss_layout(&g, &arena);
    *gauss = g;
    return SB_OK;
}

REGI_API void regi_gauss_free(regi_gauss *gauss)
{
    sbi_free(&gauss->allocator, gauss->memory);
    memset(gauss, 0, sizeof *gauss);
}

/* ---- dense ---- */

/* In four sums, none of which waits for another. */
static double regi_gauss_dot(const double *a, const double *b, int n)
{
    double sum[4] = {0, 0, 0, 0};
    int i = 0;
    for (; i + 4 <= n; i += 4)
        for (int k = 0; k < 4; k++)
            sum[k] += a[i + k] * b[i + k];
    for (; i < n; i++)
        sum[0] += a[i] * b[i];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

static void regi_gauss_add(double *SB_RESTRICT to, double factor, const double *SB_RESTRICT from, int n)
{
    for (int i = 0; i < n; i++)
        to[i] += factor * from[i];
}

/* Upper triangle of upper[n][stride] += factor * rows^T rows of rows[count][stride]. */
static void regi_gauss_square(int wide, double *upper, int n, double factor, const double *rows, int count,
                              size_t stride)
{
    enum { DEPTH = 64, SIDE = REGI_BLOCK_WIDTH }; /* rows that stay near */
    for (int k = 0; k < count; k += DEPTH)
        for (int i = 0; i < n; i += SIDE) {
            const double *at = rows + (size_t)k * stride + i;
            regi_block block = {NULL, NULL, 0, 0, 1, 0, 0};
            double corner[(int)SIDE * (int)SIDE], *to = upper + (size_t)i * stride + i;
            int side = sbi_min_int(SIDE, n - i);
            block.left = block.right = at;
            block.wide = wide;
            block.left_stride = block.right_step = stride;
            block.depth = sbi_min_int(DEPTH, count - k);
            memset(corner, 0, sizeof corner);
            regi_block_add(&block, side, side, factor, corner, SIDE);
            for (int r = 0; r < side; r++)
                regi_gauss_add(to + (size_t)r * stride + r, 1, corner + r * (int)SIDE + r, side - r);
            block.left += side;
            regi_block_add(&block, n - i - side, side, factor, to + side, stride);
        }
}

REGI_API void regi_gauss_add_squares(int wide, double *upper, int n, const double *rows, int count, size_t stride)
{
    regi_gauss_square(wide, upper, n, 1, rows, count, stride);
}

REGI_API int regi_gauss_cholesky(int wide, double *a, int n, size_t stride)
{
    enum { BLOCK = 32 };
    for (int first = 0; first < n; first += BLOCK) {
        int next = sbi_min_int(first + BLOCK, n);
        for (int k = first; k < next; k++) {
            double *row = a + (size_t)k * stride, scale;
            if (!(row[k] > 0))
                return 0;
            scale = 1 / sqrt(row[k]);
            for (int j = k; j < n; j++)
                row[j] *= scale;
            for (int i = k + 1; i < next; i++)
                regi_gauss_add(a + (size_t)i * stride + i, -row[i], row + i, n - i);
        }
        regi_gauss_square(wide, a + (size_t)next * stride + next, n - next, -1, a + (size_t)first * stride + next,
                          next - first, stride);
    }
    return 1;
}

/* r <- U^-T r */
static void regi_gauss_forward(const double *u, int n, size_t stride, double *r)
{
    for (int k = 0; k < n; k++) {
        const double *row = u + (size_t)k * stride;
        r[k] /= row[k];
        regi_gauss_add(r + k + 1, -r[k], row + k + 1, n - k - 1);
    }
}

/* r <- U^-1 r */
static void regi_gauss_backward(const double *u, int n, size_t stride, double *r)
{
    for (int k = n - 1; k >= 0; k--) {
        const double *row = u + (size_t)k * stride;
        r[k] = (r[k] - regi_gauss_dot(row + k + 1, r + k + 1, n - k - 1)) / row[k];
    }
}

REGI_API void regi_gauss_substitute(const double *u, int n, size_t stride, double *r)
{
    regi_gauss_forward(u, n, stride, r);
    regi_gauss_backward(u, n, stride, r);
}

/* ---- resultants ---- */

/* Makes the rows of B orthonormal; those that are sums of the ones before become 0. */
static void regi_gauss_orthogonalise(regi_gauss *g)
{
    for (int e = 0; e < g->exact; e++) {
        double *row = g->resultants + (size_t)e * (size_t)g->most_loads, before, after;
        before = sqrt(regi_gauss_dot(row, row, g->loads));
        for (int twice = 0; twice < 2; twice++)
            for (int k = 0; k < e; k++) {
                const double *other = g->resultants + (size_t)k * (size_t)g->most_loads;
                regi_gauss_add(row, -regi_gauss_dot(row, other, g->loads), other, g->loads);
            }
        after = sqrt(regi_gauss_dot(row, row, g->loads));
        for (int b = 0; b < g->loads; b++)
            row[b] = after > 1e-9 * before ? row[b] / after : 0;
    }
}

REGI_API void regi_gauss_bind(regi_gauss *g)
{
    size_t m = (size_t)g->most;
    regi_gauss_orthogonalise(g);
    for (int e = 0; e < g->exact; e++) {
        const double *row = g->resultants + (size_t)e * (size_t)g->most_loads;
        memset(g->scratch, 0, (size_t)g->count * sizeof(double));
        for (int b = 0; b < g->loads; b++)
            regi_gauss_add(g->scratch, row[b], g->columns + (size_t)b * m, g->count);
        for (int b = 0; b < g->loads; b++)
            regi_gauss_add(g->columns + (size_t)b * m, -row[b], g->scratch, g->count);
    }
}

REGI_API void regi_gauss_balance(const regi_gauss *g, double *c)
{
    for (int e = 0; e < g->exact; e++) {
        const double *row = g->resultants + (size_t)e * (size_t)g->most_loads;
        regi_gauss_add(c, -regi_gauss_dot(row, c, g->loads), row, g->loads);
    }
}

REGI_API void regi_gauss_multiply(regi_gauss *g)
{
    size_t m = (size_t)g->most;
    for (int i = 0; i < g->count; i++)
        memset(g->gram + (size_t)i * m, 0, (size_t)g->count * sizeof(double));
    regi_gauss_add_squares(g->wide, g->gram, g->count, g->columns, g->loads, m);
}

/* ---- posterior ---- */

REGI_API int regi_gauss_solve(regi_gauss *g)
{
    size_t m = (size_t)g->most;
    for (int i = 0; i < g->count; i++) {
        double *row = g->system + (size_t)i * m;
        for (int j = i; j < g->count; j++)
            row[j] = g->scale * g->scale * g->gram[(size_t)i * m + (size_t)j];
        row[i] += g->variance[i];
    }
    regi_gauss_add_squares(g->wide, g->system, g->count, g->pose, g->poses, m);
    if (!regi_gauss_cholesky(g->wide, g->system, g->count, m))
        return 0;
    memcpy(g->multiplier, g->gap, (size_t)g->count * sizeof(double));
    regi_gauss_apply_inverse(g, g->multiplier);
    return 1;
}

REGI_API void regi_gauss_whiten(const regi_gauss *g, double *r)
{
    regi_gauss_forward(g->system, g->count, (size_t)g->most, r);
}

REGI_API void regi_gauss_whiten_many(const regi_gauss *g, double *x)
{
    regi_block_forward(g->wide, g->system, g->count, (size_t)g->most, x);
}

REGI_API void regi_gauss_apply_inverse(const regi_gauss *g, double *r)
{
    regi_gauss_substitute(g->system, g->count, (size_t)g->most, r);
}

REGI_API void regi_gauss_explain(const regi_gauss *g, const double *y, double *c, double *p)
{
    for (int b = 0; b < g->loads; b++)
        c[b] = g->scale * g->scale * regi_gauss_dot(g->columns + (size_t)b * (size_t)g->most, y, g->count);
    for (int k = 0; k < g->poses; k++)
        p[k] = regi_gauss_dot(g->pose + (size_t)k * (size_t)g->most, y, g->count);
}

REGI_API void regi_gauss_predict(const regi_gauss *g, const double *c, const double *p, double *out)
{
    memset(out, 0, (size_t)g->count * sizeof(double));
    for (int b = 0; b < g->loads; b++)
        regi_gauss_add(out, c[b], g->columns + (size_t)b * (size_t)g->most, g->count);
    for (int k = 0; k < g->poses; k++)
        regi_gauss_add(out, p[k], g->pose + (size_t)k * (size_t)g->most, g->count);
}

REGI_API void regi_gauss_condition(const regi_gauss *g, double *c, double *p, double *e)
{
    size_t m = (size_t)g->most;
    for (int b = 0; b < g->loads; b++)
        regi_gauss_add(e, c[b], g->columns + (size_t)b * m, g->count);
    for (int k = 0; k < g->poses; k++)
        regi_gauss_add(e, p[k], g->pose + (size_t)k * m, g->count);
    regi_gauss_apply_inverse(g, e);
    for (int b = 0; b < g->loads; b++)
        c[b] -= g->scale * g->scale * regi_gauss_dot(g->columns + (size_t)b * m, e, g->count);
    for (int k = 0; k < g->poses; k++)
        p[k] -= regi_gauss_dot(g->pose + (size_t)k * m, e, g->count);
}

/* ---- evidence ---- */

REGI_API void regi_gauss_reduce(regi_gauss *g)
{
    size_t m = (size_t)g->most;
    double first = 0, *left = g->scratch; /* diagonal of what is left of gram */
    for (int i = 0; i < g->count; i++) {
        left[i] = g->gram[(size_t)i * m + (size_t)i];
        first = left[i] > first ? left[i] : first;
    }
    for (g->rank = 0; g->rank < REGI_GAUSS_RANK && g->rank < g->count; g->rank++) {
        double *row = g->low + (size_t)g->rank * m, scale;
        int at = 0;
        for (int i = 1; i < g->count; i++)
            at = left[i] > left[at] ? i : at;
        if (!(left[at] > 1e-8 * first)) /* a ten-thousandth of the motion that the prior holds for likely */
            break;
        for (int i = 0; i < g->count; i++)
            row[i] = i < at ? g->gram[(size_t)i * m + (size_t)at] : g->gram[(size_t)at * m + (size_t)i];
        for (int k = 0; k < g->rank; k++)
            regi_gauss_add(row, -g->low[(size_t)k * m + (size_t)at], g->low + (size_t)k * m, g->count);
        scale = 1 / sqrt(left[at]);
        for (int i = 0; i < g->count; i++) {
            row[i] *= scale;
            left[i] -= row[i] * row[i];
        }
        left[at] = 0;
    }
}

/* The variance that stands for one in the evidence: data that are met exactly count as met to a thousandth of the least
 * deviation of the others. */
static double regi_gauss_floor(const regi_gauss *g)
{
    double least = 0;
    for (int i = 0; i < g->count; i++)
        if (g->variance[i] > 0 && (!(least > 0) || g->variance[i] < least))
            least = g->variance[i];
    return least > 0 ? 1e-6 * least : 1e-300;
}

/* weighted: a row of each datum over its deviation, of the pose's columns, of low, and of the gap. Returns
 * log |diag(variance)|. */
static double regi_gauss_weigh(regi_gauss *g)
{
    size_t m = (size_t)g->most;
    double floor = regi_gauss_floor(g), volume = 0;
    for (int i = 0; i < g->count; i++) {
        double variance = g->variance[i] > floor ? g->variance[i] : floor, sure = 1 / sqrt(variance);
        double *to = g->weighted + (size_t)i * REGI_GAUSS_WIDTH;
        for (int k = 0; k < g->poses; k++)
            *to++ = sure * g->pose[(size_t)k * m + (size_t)i];
        for (int a = 0; a < g->rank; a++)
            *to++ = sure * g->low[(size_t)a * m + (size_t)i];
        *to = sure * g->gap[i];
        volume += sbi_dense_log(variance);
    }
    return volume;
}

/* products, upper triangle: those of weighted's columns, with Sigma^-1 between them once the pose's are eliminated:
 * Sigma^-1 = D^-1 - D^-1 R (I + R^T D^-1 R)^-1 R^T D^-1, D = diag(variance). *volume: log |I + R^T D^-1 R|. 0: they are
 * not finite. */
static int regi_gauss_free_of_pose(regi_gauss *g, double *volume)
{
    int n = g->poses + g->rank + 1;
    memset(g->products, 0, (size_t)n * REGI_GAUSS_WIDTH * sizeof(double));
    regi_gauss_add_squares(g->wide, g->products, n, g->weighted, g->count, REGI_GAUSS_WIDTH);
    *volume = 0;
    for (int k = 0; k < g->poses; k++) {
        double *row = g->products + (size_t)k * REGI_GAUSS_WIDTH, pivot = 1 + row[k];
        if (!(pivot > 0))
            return 0;
        *volume += sbi_dense_log(pivot);
        for (int i = k + 1; i < n; i++)
            regi_gauss_add(g->products + (size_t)i * REGI_GAUSS_WIDTH + i, -row[i] / pivot, row + i, n - i);
    }
    return 1;
}

REGI_API int regi_gauss_spectrum(regi_gauss *g)
{
    const double *free_of_pose = g->products + (size_t)g->poses * REGI_GAUSS_WIDTH + g->poses;
    double variances = regi_gauss_weigh(g), volume;
    if (!regi_gauss_free_of_pose(g, &volume))
        return 0;
    g->rigid_misfit = free_of_pose[(size_t)g->rank * REGI_GAUSS_WIDTH + (size_t)g->rank];
    g->rigid_volume = variances + volume;
    for (int a = 0; a < g->rank; a++) {
        g->along[a] = free_of_pose[(size_t)a * REGI_GAUSS_WIDTH + (size_t)g->rank];
        for (int b = 0; b <= a; b++)
            g->small[(size_t)a * (size_t)g->rank + (size_t)b] = free_of_pose[(size_t)b * REGI_GAUSS_WIDTH + (size_t)a];
    }
    if (g->rank > 0) {
        sbi_symmetric_tridiagonalise(g->small, g->rank, g->diagonal, g->beside, g->scratch, g->scratch + g->rank);
        sbi_symmetric_turn(g->small, g->rank, g->scratch, g->along);
    }
    return fabs(g->rigid_misfit) < 1e300 && (g->rank == 0 || fabs(g->diagonal[g->rank - 1]) < 1e300); /* not NaN */
}

/* |I + scale^2 T| and b^T (I + scale^2 T)^-1 b of the tridiagonal T, by elimination. */
REGI_API double regi_gauss_evidence(const regi_gauss *g, double scale)
{
    double square = scale * scale, misfit = g->rigid_misfit, volume = g->rigid_volume, pivot = 1, part = 0;
    for (int k = 0; k < g->rank; k++) {
        double beside = k > 0 ? square * g->beside[k - 1] : 0, ratio = beside / pivot;
        pivot = 1 + square * g->diagonal[k] - ratio * beside;
        pivot = pivot > 1 ? pivot : 1; /* T has no negative eigenvalues but for rounding */
        part = g->along[k] - ratio * part;
        misfit -= square * part * part / pivot;
        volume += sbi_dense_log(pivot);
    }
    return -0.5 * (misfit + volume);
}

REGI_API double regi_gauss_best_scale(const regi_gauss *g, double *evidence)
{
    double gaps = 0, trace = 0, best = 0, most = 0, middle;
    for (int i = 0; i < g->count; i++) {
        gaps += g->gap[i] * g->gap[i];
        trace += g->gram[(size_t)i * (size_t)g->most + (size_t)i];
    }
    middle = trace > 0 && gaps > 0 ? sqrt(gaps / trace) : 1;
    for (int k = 0; k < REGI_GAUSS_SCALES; k++) {
        double scale = middle * sbi_dense_exp(2.302585092994046 * (k - REGI_GAUSS_SCALES / 2) / 10);
        double found = regi_gauss_evidence(g, scale);
        if (k == 0 || found > most) {
            most = found;
            best = scale;
        }
    }
    *evidence = most;
    return best;
}

/* ==== src/register/prior.h ==== */
/* prior: what acts on an organ before anything was seen: tractions on its surface, a Gaussian process, and gravity.
 * Floor 6, internal.
 *
 * The traction is tau(x) = sum_j psi_j(x) tau_j of control points spread over the surface, psi_j >= 0 of compact
 * support that sum to 1, and per axis cov(tau_i, tau_j) = s^2 c_i c_j d_i d_j k(|x_i - x_j| / l),   k(z) = (1 + sqrt3
 * z) exp(-sqrt3 z)     (Matern 3/2) with s one scale for all, d a local one whose square has the mean 1, and l a
 * length. What acts on thin parts is limited by what they would do under it (c, `calm`): with loads as elsewhere an ear
 * would move by more than the whole organ is long, and does so where it is not seen. Nodes bear the forces f_a = int
 * N_a tau dA, integrated over the facets (6 points on a tri6: sharing a facet's area evenly over its six nodes would
 * put half of the load on corners that bear none of it). Gravity adds f_a = a int N_a dV / V. */
#ifndef REGI_PRIOR_H
#define REGI_PRIOR_H


enum { REGI_PRIOR_CONTROLS = 240 }; /* at most */

typedef struct regi_prior {
    int node_count;    /* of the organ */
    int control_count; /* c */
    int wide;          /* what sbi_lanes_are_wide() said */
    double size;       /* m: diagonal of the organ's box */
    double area;       /* m^2 of its surface */
    sb_vec3 *places;   /* [c] control points at rest (m) */
    double *areas;     /* [c] int psi_j dA (m^2) */
    double *calm;      /* [c] share of the scale that it has: less than 1 where the organ gives way; 1 once made */
    int *start;        /* [nodes + 1] into controls and shares */
    int *controls;     /* by node: the control points whose traction it bears a part of, ascending, */
    sb_real *shares;   /* and int N_a psi_j dA (m^2) */
    sb_real *weight;   /* [nodes] int N_a dV / V */
    sb_allocator allocator;
    void *memory, *lists;
} regi_prior;

/* For a mesh of volumes and its boundary, made with compact 1. SB_ERROR_MESH (no area, no volume), SB_ERROR_MEMORY. */
REGI_API sb_result regi_prior_create(const sb_mesh *mesh, const sb_boundary *boundary, const sb_allocator *allocator,
                                     regi_prior *prior, sb_error *error);
REGI_API void regi_prior_free(regi_prior *prior); /* zeros are fine */

/* Forces (N) of tractions[c] (Pa) and of a total weight (N): forces[nodes] are overwritten. */
REGI_API void regi_prior_forces(const regi_prior *prior, const sb_vec3 *tractions, sb_vec3 weight, sb_vec3 *forces);
/* What the forces of one traction do along a row: out[c][3] = sum_a shares_aj row_a, row[nodes]. */
REGI_API void regi_prior_collect(const regi_prior *prior, const sb_vec3 *row, sb_vec3 *out, sb_vec3 *weight);

/* root[c][c], lower: C D k D C + jitter = root root^T for a length in shares of the size and local[c] (d; NULL: 1).
 * Returns 0 when it has none. */
REGI_API int regi_prior_root(const regi_prior *prior, double length, const double *local, double *root);
/* local[c]: the local scale that energy[c], what is expected of |tau_j|^2, suggests after smoothing over half the
 * length. */
REGI_API void regi_prior_localise(const regi_prior *prior, double length, const double *energy, double *local);

#endif /* REGI_PRIOR_H */

/* ==== src/register/prior.c ==== */
/* prior: see prior.h. */

#include <math.h>
#include <string.h>


/* Work while a prior is made. */
typedef struct regi_prior_draft {
    const sb_mesh *skin;
    const int *nodes; /* [skin nodes] of the organ */
    int *chosen;      /* [c] skin nodes */
    sb_real *scratch; /* [skin nodes] */
    sb_real *psi;     /* [skin nodes][c] */
    sb_real *full;    /* [skin nodes][c] shares */
} regi_prior_draft;

static void regi_prior_layout_draft(regi_prior_draft *draft, int controls, sbi_arena *arena)
{
    size_t n = (size_t)draft->skin->node_count, c = (size_t)controls;
    draft->chosen = (int *)sbi_arena_take(arena, c, sizeof(int));
    draft->scratch = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    draft->psi = (sb_real *)sbi_arena_take(arena, n, c * sizeof(sb_real));
    draft->full = (sb_real *)sbi_arena_take(arena, n, c * sizeof(sb_real));
}

static void regi_prior_layout(regi_prior *p, sbi_arena *arena)
{
    size_t n = (size_t)p->node_count, c = (size_t)p->control_count;
    p->places = (sb_vec3 *)sbi_arena_take(arena, c, sizeof(sb_vec3));
    p->areas = (double *)sbi_arena_take(arena, c, sizeof(double));
    p->calm = (double *)sbi_arena_take(arena, c, sizeof(double));
    p->start = (int *)sbi_arena_take(arena, n + 1, sizeof(int));
    p->weight = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
}

/* psi at the nodes of the skin: Shepard weights (1 - r/reach)^2 with a reach of twice the spacing, which every node has
 * a few control points within. With all nodes chosen each has its own. */
static void regi_prior_spread(const regi_prior *p, const regi_prior_draft *draft)
{
    int nodes = draft->skin->node_count, c = p->control_count;
    sb_real spacing = 0, reach;
    for (int i = 0; i < nodes; i++) {
        sb_real *row = draft->psi + (size_t)i * (size_t)c, nearest = SB_REAL_MAX;
        for (int j = 0; j < c; j++) {
            row[j] = sb_v3_norm(sb_v3_sub(draft->skin->nodes[i], p->places[j]));
            nearest = sb_min(nearest, row[j]);
        }
        spacing = sb_max(spacing, nearest);
    }
    reach = (sb_real)1.5 * spacing;
    if (!(reach > 0)) /* nodes in one place */
        reach = (sb_real)(1e-6 * p->size);
    for (int i = 0; i < nodes; i++) {
        sb_real *row = draft->psi + (size_t)i * (size_t)c, sum = 0;
        for (int j = 0; j < c; j++) {
            sb_real r = row[j];
            row[j] = c == nodes ? (sb_real)(draft->chosen[j] == i) : r < reach ? (1 - r / reach) * (1 - r / reach) : 0;
            sum += row[j];
        }
        for (int j = 0; j < c; j++)
            row[j] /= sum;
    }
}

/* Adds what one facet bears: w N_a sum_b N_b psi_b at its points. */
static void regi_prior_add_facet(regi_prior *p, const regi_prior_draft *draft, const int *corners, int width)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    size_t c = (size_t)p->control_count;
    int count = sb_element_quadrature(draft->skin->element_type, SB_QUADRATURE_FACE, points, weights);
    for (int q = 0; q < count; q++) {
        sb_real shape[SB_MAX_ELEMENT_NODES], slope[SB_MAX_ELEMENT_NODES][3], w;
        sb_vec3 along = sb_v3(0, 0, 0), across = sb_v3(0, 0, 0);
        sb_element_shape(draft->skin->element_type, points[q], shape, slope);
        for (int a = 0; a < width; a++) {
            along = sb_v3_madd(along, slope[a][0], draft->skin->nodes[corners[a]]);
            across = sb_v3_madd(across, slope[a][1], draft->skin->nodes[corners[a]]);
        }
        w = weights[q] * sb_v3_norm(sb_v3_cross(along, across));
        p->area += (double)w;
        for (size_t j = 0; j < c; j++) {
            sb_real psi = 0;
            for (int b = 0; b < width; b++)
                psi += shape[b] * draft->psi[(size_t)corners[b] * c + j];
            if (psi == 0)
                continue;
            p->areas[j] += (double)(w * psi);
            for (int a = 0; a < width; a++)
                draft->full[(size_t)corners[a] * c + j] += w * psi * shape[a];
        }
    }
}

/* Shares of the nodes, without those of control points that do not act there. */
static sb_result regi_prior_list(regi_prior *p, const regi_prior_draft *draft, sb_error *error)
{
    size_t c = (size_t)p->control_count, at = 0, all;
    int nodes = draft->skin->node_count, next = 0;
    size_t count = 0;
    for (size_t k = 0; k < (size_t)nodes * c; k++)
        count += draft->full[k] != 0;
    all = count * sizeof(int);
    all = (all + 63) / 64 * 64;
    p->lists = sbi_alloc(&p->allocator, all + count * sizeof(sb_real), 1);
    if (!p->lists)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the loads of %d nodes", nodes);
    p->controls = (int *)p->lists;
    p->shares = (sb_real *)(void *)((unsigned char *)p->lists + all);
    for (int i = 0; i < p->node_count; i++) { /* compact boundaries keep the order of the nodes */
        p->start[i] = (int)at;
        if (next == nodes || draft->nodes[next] != i)
            continue;
        for (size_t j = 0; j < c; j++)
            if (draft->full[(size_t)next * c + j] != 0) {
                p->controls[at] = (int)j;
                p->shares[at++] = draft->full[(size_t)next * c + j];
            }
        next++;
    }
    p->start[p->node_count] = (int)at;
    return SB_OK;
}

/* int N_a dV / V */
static sb_result regi_prior_weigh(regi_prior *p, const sb_mesh *mesh, sb_error *error)
{
    sbi_element element = sbi_element_make(mesh->element_type, mesh->table);
    int width = sb_mesh_element_width(mesh);
    double volume = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = mesh->elements + (size_t)e * (size_t)width;
        sb_vec3 x[SB_MAX_ELEMENT_NODES];
        sb_real mass[SB_MAX_ELEMENT_NODES * SB_MAX_ELEMENT_NODES], load[SB_MAX_ELEMENT_NODES];
        for (int a = 0; a < width; a++)
            x[a] = mesh->nodes[nodes[a]];
        sbi_element_mass(element, SB_MASS_CONSISTENT, x, mass, load);
        for (int a = 0; a < width; a++) {
            p->weight[nodes[a]] += load[a];
            volume += (double)load[a];
        }
    }
    if (!(volume > 0) || !(p->area > 0))
        return sbi_fail(error, SB_ERROR_MESH, "an organ of %g m^3 and %g m^2 bears no loads", volume, p->area);
    for (int i = 0; i < p->node_count; i++)
        p->weight[i] = (sb_real)((double)p->weight[i] / volume);
    return SB_OK;
}

static sb_result regi_prior_fill(regi_prior *p, const sb_mesh *mesh, regi_prior_draft *draft, sb_error *error)
{
    int width = sb_mesh_element_width(draft->skin);
    sb_result result;
    for (int j = 0; j < p->control_count; j++) {
        p->places[j] = draft->skin->nodes[draft->chosen[j]];
        p->calm[j] = 1;
    }
    regi_prior_spread(p, draft);
    for (int f = 0; f < draft->skin->element_count; f++)
        regi_prior_add_facet(p, draft, draft->skin->elements + (size_t)f * (size_t)width, width);
    result = regi_prior_list(p, draft, error);
    return result == SB_OK ? regi_prior_weigh(p, mesh, error) : result;
}

REGI_API sb_result regi_prior_create(const sb_mesh *mesh, const sb_boundary *boundary, const sb_allocator *allocator,
                                     regi_prior *prior, sb_error *error)
{
    regi_prior p;
    regi_prior_draft draft;
    sbi_arena arena = {NULL, 0, 0};
    sb_vec3 low, high;
    void *scratch;
    int wanted = sbi_min_int(boundary->surface.node_count, REGI_PRIOR_CONTROLS);
    sb_result result;
    memset(&p, 0, sizeof p);
    memset(&draft, 0, sizeof draft);
    if (allocator)
        p.allocator = *allocator;
    draft.skin = &boundary->surface;
    draft.nodes = boundary->nodes;
    p.node_count = mesh->node_count;
    p.wide = sbi_lanes_are_wide();
    sb_mesh_bounds(mesh, &low, &high);
    p.size = (double)sb_v3_norm(sb_v3_sub(high, low));
    regi_prior_layout_draft(&draft, wanted, &arena);
    scratch = arena.overflow ? NULL : sbi_alloc_zeroed(&p.allocator, 1, arena.used);
    if (!scratch)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the loads of %d nodes", draft.skin->node_count);
    arena.base = (unsigned char *)scratch;
    arena.used = 0;
    regi_prior_layout_draft(&draft, wanted, &arena);
    p.control_count = reg_cloud_spread(draft.skin->nodes, draft.skin->node_count, wanted, draft.chosen, draft.scratch);
    memset(&arena, 0, sizeof arena);
    regi_prior_layout(&p, &arena);
    p.memory = arena.overflow ? NULL : sbi_alloc_zeroed(&p.allocator, 1, arena.used);
    if (p.memory) {
        arena.base = (unsigned char *)p.memory;
        arena.used = 0;
        regi_prior_layout(&p, &arena);
        result = regi_prior_fill(&p, mesh, &draft, error);
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the loads of %d nodes", p.node_count);
    }
    sbi_free(&p.allocator, scratch);
    if (result == SB_OK)
        *prior = p;
    else
        regi_prior_free(&p);
    return result;
}

REGI_API void regi_prior_free(regi_prior *prior)
{
    sbi_free(&prior->allocator, prior->memory);
    sbi_free(&prior->allocator, prior->lists);
    memset(prior, 0, sizeof *prior);
}

REGI_API void regi_prior_forces(const regi_prior *p, const sb_vec3 *tractions, sb_vec3 weight, sb_vec3 *forces)
{
    for (int i = 0; i < p->node_count; i++) {
        forces[i] = sb_v3_scale(p->weight[i], weight);
        for (int k = p->start[i]; k < p->start[i + 1]; k++)
            forces[i] = sb_v3_madd(forces[i], p->shares[k], tractions[p->controls[k]]);
    }
}

REGI_API void regi_prior_collect(const regi_prior *p, const sb_vec3 *row, sb_vec3 *out, sb_vec3 *weight)
{
    memset(out, 0, (size_t)p->control_count * sizeof *out);
    *weight = sb_v3(0, 0, 0);
    for (int i = 0; i < p->node_count; i++) {
        *weight = sb_v3_madd(*weight, p->weight[i], row[i]);
        for (int k = p->start[i]; k < p->start[i + 1]; k++)
            out[p->controls[k]] = sb_v3_madd(out[p->controls[k]], p->shares[k], row[i]);
    }
}

/* Matern 3/2 */
static double regi_prior_kernel(double z)
{
    double t = 1.7320508075688772 * z;
    return (1 + t) * sbi_dense_exp(-t);
}

static double regi_prior_apart(const regi_prior *p, int i, int j)
{
    return (double)sb_v3_norm(sb_v3_sub(p->places[i], p->places[j]));
}

REGI_API int regi_prior_root(const regi_prior *p, double length, const double *local, double *root)
{
    int c = p->control_count;
    for (int i = 0; i < c; i++)
        for (int j = i; j < c; j++) {
            double scale = p->calm[i] * p->calm[j] * (local ? local[i] * local[j] : 1);
            root[(size_t)i * (size_t)c + (size_t)j] =
                scale * (regi_prior_kernel(regi_prior_apart(p, i, j) / (length * p->size)) + (i == j ? 1e-9 : 0));
        }
    if (!regi_gauss_cholesky(p->wide, root, c, (size_t)c))
        return 0;
    for (int i = 0; i < c; i++) /* U^T is the lower root */
        for (int j = i + 1; j < c; j++) {
            root[(size_t)j * (size_t)c + (size_t)i] = root[(size_t)i * (size_t)c + (size_t)j];
            root[(size_t)i * (size_t)c + (size_t)j] = 0;
        }
    return 1;
}

/* What is expected at a control point, as if it bore loads like any other. */
static double regi_prior_energy(const regi_prior *p, const double *energy, int control)
{
    return energy[control] / (p->calm[control] * p->calm[control]);
}

/* d^2 = (nu phi + energy) / (nu + 1) over the mean; energies are averaged with a Gaussian of l / 2 first. What is not
 * seen keeps the variance that it has, so that nothing is declared free of loads because nobody looked. */
REGI_API void regi_prior_localise(const regi_prior *p, double length, const double *energy, double *local)
{
    const double phi = 0.2, nu = 1, degrees = 3;
    int c = p->control_count;
    double mean = 0, area = 0, reach = 0.5 * length * p->size;
    for (int i = 0; i < c; i++) {
        mean += p->areas[i] * regi_prior_energy(p, energy, i);
        area += p->areas[i];
    }
    mean /= area;
    area = 0;
    for (int i = 0; i < c; i++) {
        double sum = 0, weights = 0;
        for (int j = 0; j < c; j++) {
            double z = regi_prior_apart(p, i, j) / reach, w = p->areas[j] * sbi_dense_exp(-0.5 * z * z);
            sum += w * regi_prior_energy(p, energy, j);
            weights += w;
        }
        local[i] = (nu * phi * mean + degrees * sum / weights) / (nu + degrees);
        area += p->areas[i];
    }
    mean = 0;
    for (int i = 0; i < c; i++)
        mean += p->areas[i] * local[i] / area;
    for (int i = 0; i < c; i++)
        local[i] = mean > 0 ? sqrt(local[i] / mean) : 1;
}

/* ==== src/register/model_private.h ==== */
/* model_private: what is inside a reg_model. Floor 6, internal. */
#ifndef REG_MODEL_PRIVATE_H
#define REG_MODEL_PRIVATE_H


/* Young's modulus that models have (Pa): loads are in shares of it. */
#define REGI_MODEL_YOUNG ((sb_real)1000)

struct reg_model {
    sb_allocator allocator;
    sb_jobs jobs;
    sb_body *body;        /* neo-Hookean, whatever an application's body is: its tangent is right at strains of a
                           * tenth, where that of corotated bodies bends what is found of the loads */
    sb_direct *direct;    /* the body's factor: one inference at a time */
    int direct_at_rest;   /* 1: it is that of the organ at rest */
    sb_mesh mesh;         /* at rest */
    sb_boundary boundary; /* of mesh, compact */
    regi_prior prior;
    sb_domain domain;       /* the body's points: for forces of elements */
    sb_mesh skin;           /* triangles that are seen, at rest */
    sb_surface *tree;       /* of skin where the organ is now */
    sb_embedding_rows rows; /* of skin's nodes in mesh's */
    sb_real *vertex_area;   /* [skin nodes] m^2 at rest */
    double area;            /* m^2 of the skin */
    sb_real size;           /* m: diagonal of the mesh's box */
    double spacing;         /* m: cube root of the volume that a node has, about its distance from the next */
    sb_real poisson;
    int held; /* 1: there are fixed nodes */
};

/* ---- model_calm ---- */
/* Makes `direct`, and the prior's calm, of the body at rest. The factor's errors, SB_ERROR_MEMORY. */
REGI_API sb_result regi_model_find_calm(reg_model *model, sb_error *error);

#endif /* REG_MODEL_PRIVATE_H */

/* ==== src/register/model.c ==== */
/* model: see model.h. */

#include <math.h>
#include <string.h>


#define REGI_MODEL_COOKIE 0x6d6f646cu

REG_API reg_model_def reg_default_model_def(void)
{
    reg_model_def def;
    memset(&def, 0, sizeof def);
    def.poisson = (sb_real)0.45;
    def.cookie = REGI_MODEL_COOKIE;
    return def;
}

static sb_result regi_model_check(const reg_model_def *def, sb_error *error)
{
    if (!def || def->cookie != REGI_MODEL_COOKIE || !def->mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a model needs a def made by reg_default_model_def, and a mesh");
    if (!(def->poisson > -1 && def->poisson < (sb_real)0.5))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "Poisson's ratio is %g, not in (-1, 0.5)", (double)def->poisson);
    if (def->fixed_count < 0 || (def->fixed_count > 0 && !def->fixed))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d fixed nodes, but no array of them", def->fixed_count);
    if (def->mesh->element_type == SB_CUSTOM)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "a model of custom elements cannot be registered");
    return SB_OK;
}

static sb_result regi_model_make_body(reg_model *model, const reg_model_def *def, sb_error *error)
{
    sb_body_def body = sb_default_body_def();
    sb_result result;
    body.mesh = def->mesh;
    body.material = sb_material_neo_hookean(REGI_MODEL_YOUNG, def->poisson, 1000);
    body.allocator = def->allocator;
    body.jobs = def->jobs;
    result = sb_body_create(&body, &model->body, error);
    if (result == SB_OK && def->fixed_count > 0)
        result = sb_body_hold(model->body, def->fixed, def->fixed_count, SB_XYZ, error);
    if (result == SB_OK)
        result = sb_mesh_copy(def->mesh, &def->allocator, &model->mesh, error);
    if (result == SB_OK)
        result = sb_domain_create(&model->mesh, SB_INTEGRATION_AUTO, 0, &def->allocator, &model->domain, error);
    if (result == SB_OK)
        result = sb_mesh_boundary(&model->mesh, 1, &def->allocator, &model->boundary, error);
    return result;
}

/* The surface's nodes as rows of the mesh's. */
static sb_result regi_model_hold_skin(reg_model *model, sb_error *error)
{
    sb_embedding_def embed = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_result result;
    embed.mesh = &model->mesh;
    embed.points = model->skin.nodes;
    embed.point_count = model->skin.node_count;
    embed.kind = SB_EMBED_PLAIN;
    embed.max_distance = (sb_real)0.25 * model->size; /* beyond, surface and mesh are not of one organ */
    embed.allocator = model->allocator;
    embed.jobs = model->jobs;
    result = sb_embedding_create(&embed, &embedding, error);
    if (result == SB_OK)
        result = sb_embedding_mapping(embedding, &model->allocator, &model->rows, error);
    sb_embedding_destroy(embedding);
    return result;
}

static sb_result regi_model_measure_skin(reg_model *model, sb_error *error)
{
    const sb_mesh *skin = &model->skin;
    model->vertex_area = (sb_real *)sbi_alloc_zeroed(&model->allocator, (size_t)skin->node_count, sizeof(sb_real));
    if (!model->vertex_area)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d vertices", skin->node_count);
    for (int t = 0; t < skin->element_count; t++) {
        const int *c = skin->elements + 3 * (size_t)t;
        sb_vec3 a = sb_v3_sub(skin->nodes[c[1]], skin->nodes[c[0]]),
                b = sb_v3_sub(skin->nodes[c[2]], skin->nodes[c[0]]);
        sb_real area = (sb_real)0.5 * sb_v3_norm(sb_v3_cross(a, b));
        model->area += (double)area;
        for (int k = 0; k < 3; k++)
            model->vertex_area[c[k]] += area / 3;
    }
    return model->area > 0 ? SB_OK : sbi_fail(error, SB_ERROR_MESH, "the organ's surface has no area");
}

static sb_result regi_model_make_skin(reg_model *model, const reg_model_def *def, sb_error *error)
{
    const sb_mesh *surface = def->surface ? def->surface : &model->boundary.surface;
    sb_result result = sb_surface_triangulate(surface, &model->allocator, &model->skin, error);
    if (result == SB_OK)
        result = sb_surface_create(&model->skin, &model->allocator, &model->tree, error);
    if (result == SB_OK)
        result = regi_model_hold_skin(model, error);
    return result == SB_OK ? regi_model_measure_skin(model, error) : result;
}

REG_API sb_result reg_model_create(const reg_model_def *def, reg_model **model, sb_error *error)
{
    reg_model *made;
    sb_vec3 low, high;
    sb_result result = regi_model_check(def, error);
    if (result == SB_OK && !model)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "no place for a model");
    if (result != SB_OK)
        return result;
    made = (reg_model *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a model");
    made->allocator = def->allocator;
    made->jobs = def->jobs;
    made->poisson = def->poisson;
    made->held = def->fixed_count > 0;
    result = regi_model_make_body(made, def, error);
    if (result == SB_OK) {
        sb_mesh_bounds(&made->mesh, &low, &high);
        made->size = sb_v3_norm(sb_v3_sub(high, low));
        made->spacing = cbrt(fabs((double)sb_mesh_volume(&made->mesh)) / made->mesh.node_count);
        result = regi_prior_create(&made->mesh, &made->boundary, &def->allocator, &made->prior, error);
    }
    if (result == SB_OK)
        result = regi_model_make_skin(made, def, error);
    if (result == SB_OK)
        result = regi_model_find_calm(made, error);
    if (result == SB_OK)
        *model = made;
    else
        reg_model_destroy(made);
    return result;
}

REG_API void reg_model_destroy(reg_model *model)
{
    sb_allocator allocator;
    if (!model)
        return;
    allocator = model->allocator;
    sbi_free(&allocator, model->vertex_area);
    sb_embedding_rows_free(&model->rows);
    sb_surface_destroy(model->tree);
    sb_mesh_free(&model->skin);
    regi_prior_free(&model->prior);
    sb_boundary_free(&model->boundary);
    sb_domain_free(&model->domain);
    sb_mesh_free(&model->mesh);
    sb_direct_free(model->direct);
    sb_body_destroy(model->body);
    sbi_free(&allocator, model);
}

REG_API int reg_model_node_count(const reg_model *model) { return model ? model->mesh.node_count : 0; }

/* ==== src/register/response.h ==== */
/* response: how an organ answers to forces where it is now, linearly. Floor 6, internal. */
#ifndef REGI_RESPONSE_H
#define REGI_RESPONSE_H


enum { REGI_RESPONSE_MODES = 6 }; /* rigid motions */

typedef struct regi_response {
    reg_model *model;
    sb_direct *direct;
    sb_vec3 centre;          /* m: turns of the pose are about it; set by the owner */
    int turned;              /* 1: the factor's frame is another: */
    sb_mat3 frame;           /* from it to that of now */
    sb_vec3 *residual;       /* [nodes] internal forces of the shape that was factored (N) */
    sb_vec3 *weighted_modes; /* [MODES][nodes] rigid motions times shares of the mass, */
    sb_vec3 *drift;          /* [MODES][nodes] what these as forces do, */
    sb_vec3 *recoil;         /* [nodes] and what the residual does, like any row that is solved for */
    double drift_system[REGI_RESPONSE_MODES * REGI_RESPONSE_MODES]; /* their products, factored, where nothing holds */
} regi_response;

/* Takes its arrays from an arena. */
REGI_API void regi_response_layout(regi_response *response, int node_count, sbi_arena *arena);
/* Factor and residual of the shape of now. The factor's errors. */
REGI_API sb_result regi_response_factor(regi_response *response, sb_error *error);
/* The same where the organ has its shape at rest, turned as told: the factor is that of the organ at rest, which the
 * model may still have. */
REGI_API sb_result regi_response_factor_turned(regi_response *response, sb_mat3 rotation, sb_error *error);
/* A vector of now in the frame of the factor, and one of that in the frame of now. */
REGI_API sb_vec3 regi_response_to_factor(const regi_response *response, sb_vec3 v);
REGI_API sb_vec3 regi_response_from_factor(const regi_response *response, sb_vec3 v);
/* forces[nodes]: a unit rigid motion times shares of the mass; turns are about the centre and by one over the size. */
REGI_API void regi_response_mode(const regi_response *response, int mode, sb_vec3 *forces);
/* Motions of `count` rows of forces, row[count][nodes], in place: none of what is held, and
 * none of the whole, which is the pose's. */
REGI_API void regi_response_solve(regi_response *response, sb_vec3 *row, int count);

#endif /* REGI_RESPONSE_H */

/* ==== src/register/response.c ==== */
/* response: see response.h. */

#include <string.h>


REGI_API void regi_response_layout(regi_response *r, int node_count, sbi_arena *arena)
{
    size_t n = (size_t)node_count;
    r->residual = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    r->weighted_modes = (sb_vec3 *)sbi_arena_take(arena, n, REGI_RESPONSE_MODES * sizeof(sb_vec3));
    r->drift = (sb_vec3 *)sbi_arena_take(arena, n, (REGI_RESPONSE_MODES + 1) * sizeof(sb_vec3));
    r->recoil = r->drift ? r->drift + REGI_RESPONSE_MODES * n : NULL; /* solved for along with it */
}

/* What is held does not move but with the pose. */
static void regi_response_hold(const regi_response *r, sb_vec3 *row)
{
    const unsigned char *held = sb_body_supports(r->model->body);
    for (int i = 0; i < r->model->mesh.node_count; i++)
        row[i] = sbi_body_pick_axes(held[i], sb_v3(0, 0, 0), row[i]);
}

/* Takes the motion as a whole, by shares of the mass, out of u[nodes], by forces on the modes. */
static void regi_response_stop_drift(const regi_response *r, sb_vec3 *u)
{
    size_t n = (size_t)r->model->mesh.node_count;
    double c[REGI_RESPONSE_MODES];
    for (int k = 0; k < REGI_RESPONSE_MODES; k++) {
        c[k] = 0;
        for (size_t i = 0; i < n; i++)
            c[k] += (double)sb_v3_dot(r->weighted_modes[(size_t)k * n + i], u[i]);
    }
    regi_gauss_substitute(r->drift_system, REGI_RESPONSE_MODES, REGI_RESPONSE_MODES, c);
    for (int k = 0; k < REGI_RESPONSE_MODES; k++)
        for (size_t i = 0; i < n; i++)
            u[i] = sb_v3_madd(u[i], (sb_real)-c[k], r->drift[(size_t)k * n + i]);
}

REGI_API sb_vec3 regi_response_to_factor(const regi_response *r, sb_vec3 v)
{
    return r->turned ? sb_m3_tapply(r->frame, v) : v;
}

REGI_API sb_vec3 regi_response_from_factor(const regi_response *r, sb_vec3 v)
{
    return r->turned ? sb_m3_apply(r->frame, v) : v;
}

/* Rows by the factor's inverse, in place. */
static void regi_response_divide(regi_response *r, sb_vec3 *row, int count)
{
    size_t all = (size_t)count * (size_t)r->model->mesh.node_count;
    for (size_t k = 0; k < all && r->turned; k++)
        row[k] = sb_m3_tapply(r->frame, row[k]);
    (void)sb_direct_solve(r->direct, &row[0].x, &row[0].x, count);
    for (size_t k = 0; k < all && r->turned; k++)
        row[k] = sb_m3_apply(r->frame, row[k]);
}

REGI_API void regi_response_solve(regi_response *r, sb_vec3 *row, int count)
{
    for (int s = 0; s < count; s++)
        regi_response_hold(r, row + (size_t)s * (size_t)r->model->mesh.node_count);
    regi_response_divide(r, row, count);
    for (int s = 0; s < count && !r->model->held; s++)
        regi_response_stop_drift(r, row + (size_t)s * (size_t)r->model->mesh.node_count);
}

REGI_API void regi_response_mode(const regi_response *r, int mode, sb_vec3 *forces)
{
    const sb_vec3 *x = sb_body_positions(r->model->body);
    sb_vec3 axis = sb_v3(mode % 3 == 0, mode % 3 == 1, mode % 3 == 2);
    for (int i = 0; i < r->model->mesh.node_count; i++) {
        sb_vec3 turned = sb_v3_scale(1 / r->model->size, sb_v3_cross(axis, sb_v3_sub(x[i], r->centre)));
        forces[i] = sb_v3_scale(r->model->prior.weight[i], mode < 3 ? axis : turned);
    }
}

/* What modes and residual do where the organ is. 0: the modes' system is not positive. */
static int regi_response_find_drift(regi_response *r)
{
    size_t n = (size_t)r->model->mesh.node_count;
    for (int k = 0; k < REGI_RESPONSE_MODES; k++) {
        regi_response_mode(r, k, r->weighted_modes + (size_t)k * n);
        regi_response_hold(r, r->weighted_modes + (size_t)k * n);
    }
    memcpy(r->drift, r->weighted_modes, REGI_RESPONSE_MODES * n * sizeof *r->drift);
    memcpy(r->recoil, r->residual, n * sizeof *r->recoil);
    regi_response_hold(r, r->recoil);
    regi_response_divide(r, r->drift, REGI_RESPONSE_MODES + 1);
    if (r->model->held)
        return 1;
    for (int k = 0; k < REGI_RESPONSE_MODES; k++)
        for (int l = 0; l < REGI_RESPONSE_MODES; l++) {
            double sum = 0;
            for (size_t i = 0; i < n; i++)
                sum += (double)sb_v3_dot(r->weighted_modes[(size_t)k * n + i], r->drift[(size_t)l * n + i]);
            r->drift_system[k * REGI_RESPONSE_MODES + l] = sum;
        }
    if (!regi_gauss_cholesky(0, r->drift_system, REGI_RESPONSE_MODES, REGI_RESPONSE_MODES))
        return 0;
    regi_response_stop_drift(r, r->recoil);
    return 1;
}

/* The factor of the body's shape. */
static sb_result regi_response_renew(regi_response *r, sb_error *error)
{
    /* what holds nothing-held organs acts on increments only, and balanced loads do not notice */
    sb_real hold = (sb_real)(r->model->held ? 1e-4 : 1e-2) * REGI_MODEL_YOUNG * r->model->size;
    if (r->direct == r->model->direct)
        r->model->direct_at_rest = 0;
    return sbi_body_factor(r->model->body, hold, r->residual, r->direct, error);
}

static sb_result regi_response_end_factor(regi_response *r, sb_error *error)
{
    if (regi_response_find_drift(r))
        return SB_OK;
    return sbi_fail(error, SB_ERROR_INDEFINITE, "the organ's stiffness is not positive");
}

REGI_API sb_result regi_response_factor(regi_response *r, sb_error *error)
{
    sb_result result = regi_response_renew(r, error);
    r->turned = 0;
    return result == SB_OK ? regi_response_end_factor(r, error) : result;
}

/* The factor of the model at rest, wherever its body is. The residual is scratch. */
static sb_result regi_response_renew_at_rest(regi_response *r, sb_error *error)
{
    size_t bytes = (size_t)r->model->mesh.node_count * sizeof(sb_vec3);
    sb_vec3 *kept = r->drift; /* found anew afterwards */
    sb_result result;
    memcpy(kept, sb_body_displacements(r->model->body), bytes);
    memset(r->residual, 0, bytes);
    result = sb_body_set_displacements(r->model->body, r->residual);
    if (result == SB_OK)
        result = regi_response_renew(r, error);
    r->model->direct_at_rest = result == SB_OK;
    return result == SB_OK ? sb_body_set_displacements(r->model->body, kept) : result;
}

REGI_API sb_result regi_response_factor_turned(regi_response *r, sb_mat3 rotation, sb_error *error)
{
    sb_result result = r->model->direct_at_rest ? SB_OK : regi_response_renew_at_rest(r, error);
    r->turned = 1;
    r->frame = rotation;
    memset(r->residual, 0, (size_t)r->model->mesh.node_count * sizeof *r->residual); /* nothing strains it */
    return result == SB_OK ? regi_response_end_factor(r, error) : result;
}

/* ==== src/register/model_calm.c ==== */
/* model_calm: where an organ gives way so much that loads as elsewhere would move it beyond reason. */
#include <math.h>
#include <string.h>


enum { REGI_CALM_DRAWS = 16 };

/* So many times as far as half of the surface under the same loads a place may move before it bears less of them.
 * Livers come to 3.7 to 4.5 at their tips, ears of a bunny to 54. */
#define REGI_CALM_MOST 3

typedef struct regi_calm {
    regi_response response;
    sb_vec3 *moved;     /* [DRAWS][nodes] */
    sb_vec3 *tractions; /* [c] */
    double *squares;    /* [c] m^2 */
    sb_real *sort;      /* [c] */
} regi_calm;

static void regi_calm_layout(regi_calm *calm, const reg_model *model, sbi_arena *arena)
{
    size_t n = (size_t)model->mesh.node_count, c = (size_t)model->prior.control_count;
    regi_response_layout(&calm->response, model->mesh.node_count, arena);
    calm->moved = (sb_vec3 *)sbi_arena_take(arena, n, (size_t)REGI_CALM_DRAWS * sizeof(sb_vec3));
    calm->tractions = (sb_vec3 *)sbi_arena_take(arena, c, sizeof(sb_vec3));
    calm->squares = (double *)sbi_arena_take(arena, c, sizeof(double));
    calm->sort = (sb_real *)sbi_arena_take(arena, c, sizeof(sb_real));
}

/* moved: what tractions of one deviation everywhere do. */
static void regi_calm_draw(regi_calm *calm, const reg_model *model)
{
    regi_chance chance = {(uint64_t)0x9e3779b97f4a7c15u, 0, 0};
    for (int k = 0; k < REGI_CALM_DRAWS; k++) {
        for (int j = 0; j < model->prior.control_count; j++) {
            calm->tractions[j].x = (sb_real)regi_chance_normal(&chance);
            calm->tractions[j].y = (sb_real)regi_chance_normal(&chance);
            calm->tractions[j].z = (sb_real)regi_chance_normal(&chance);
        }
        regi_prior_forces(&model->prior, calm->tractions, sb_v3(0, 0, 0),
                          calm->moved + (size_t)k * (size_t)model->mesh.node_count);
    }
    regi_response_solve(&calm->response, calm->moved, REGI_CALM_DRAWS);
}

/* squares: of how far the control points' parts of the surface move. Returns their median. */
static double regi_calm_measure(regi_calm *calm, const reg_model *model)
{
    int c = model->prior.control_count;
    memset(calm->squares, 0, (size_t)c * sizeof *calm->squares);
    for (int k = 0; k < REGI_CALM_DRAWS; k++) {
        sb_vec3 weight;
        regi_prior_collect(&model->prior, calm->moved + (size_t)k * (size_t)model->mesh.node_count, calm->tractions,
                           &weight);
        for (int j = 0; j < c; j++) {
            double area = model->prior.areas[j], way = (double)sb_v3_norm(calm->tractions[j]);
            calm->squares[j] += area > 0 ? way * way / (area * area) : 0;
        }
    }
    for (int j = 0; j < c; j++)
        calm->sort[j] = (sb_real)sqrt(calm->squares[j]);
    return (double)regi_cloud_select(calm->sort, c, c / 2);
}

static sb_result regi_calm_find(regi_calm *calm, reg_model *model, sb_error *error)
{
    double usual;
    sb_result result;
    for (int i = 0; i < model->mesh.node_count; i++)
        calm->response.centre = sb_v3_madd(calm->response.centre, 1 / (sb_real)(i + 1),
                                           sb_v3_sub(model->mesh.nodes[i], calm->response.centre));
    result = regi_response_factor(&calm->response, error);
    if (result != SB_OK)
        return result;
    regi_calm_draw(calm, model);
    usual = REGI_CALM_MOST * regi_calm_measure(calm, model);
    for (int j = 0; j < model->prior.control_count && usual > 0; j++) {
        double way = sqrt(calm->squares[j]);
        model->prior.calm[j] = way > usual ? usual / way : 1;
    }
    return SB_OK;
}

REGI_API sb_result regi_model_find_calm(reg_model *model, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    regi_calm calm;
    void *memory;
    sb_result result;
    memset(&calm, 0, sizeof calm);
    regi_calm_layout(&calm, model, &arena);
    memory = arena.overflow ? NULL : sbi_alloc_zeroed(&model->allocator, 1, arena.used);
    if (!memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the motions of %d nodes", model->mesh.node_count);
    arena.base = (unsigned char *)memory;
    arena.used = 0;
    regi_calm_layout(&calm, model, &arena);
    calm.response.model = model;
    result = sbi_body_make_factor(model->body, &model->allocator, &model->direct, error);
    calm.response.direct = model->direct;
    if (result == SB_OK)
        result = regi_calm_find(&calm, model, error);
    model->direct_at_rest = result == SB_OK;
    sbi_free(&model->allocator, memory);
    return result;
}

/* ==== src/register/look.h ==== */
/* look: what is seen of an organ: points, their places of the model where it is now, and how far they are trusted.
 * Floor 6, internal. */
#ifndef REGI_LOOK_H
#define REGI_LOOK_H


/* A point of the target and its place of the model. */
typedef struct regi_look_point {
    sb_vec3 at, normal; /* m; unit, or 0 */
    sb_real weight;     /* trust given */
    sb_real sd;         /* m given, or 0 */
    int patch;
    /* of the last look */
    int triangle;         /* of the skin, or -1 */
    sb_real corner[3];    /* weights of its corners */
    sb_vec3 place, plane; /* m; unit normal of the model there */
    sb_real off;          /* gap less the median of its patch (m) */
    sb_real gap;          /* plane . (at - place) (m) */
    sb_real trust;        /* weight, less for outliers; 0: not allowed */
    sb_real share;        /* of its patch's row */
} regi_look_point;

/* Points of patches: point i of patch s has patch_start[s] <= i < patch_start[s + 1]. */
typedef struct regi_look {
    const sb_surface *tree; /* of the model's skin where it is */
    sb_real size;           /* m, of the organ */
    int has_camera;         /* 1: seen from `camera` (m) */
    sb_vec3 camera;
    regi_look_point *points; /* [point_count] by patch */
    int *patch_start;        /* [patch_count + 1] into points */
    sb_real *sort;           /* [the larger of both counts] scratch */
    sb_real noise;           /* m: of the points */
    int point_count, patch_count;
} regi_look;

/* A point with nothing known of its place; the normal may have any length. */
REGI_API void regi_look_take(regi_look_point *point, sb_vec3 at, sb_vec3 normal, sb_real weight, sb_real sd);
/* Finds a point's place. */
REGI_API void regi_look_place(const regi_look *look, regi_look_point *point);
/* Estimates the noise of the points, which have places, and trusts less what is far off: in all the target, by a limit
 * of at least `early` (m), and of so many medians of the gaps; and in its patch. */
REGI_API void regi_look_judge(regi_look *look, sb_real early, sb_real medians);
/* Shares of a patch's points in its row. Returns the variance (m^2) of their mean. */
REGI_API double regi_look_share_patch(regi_look *look, int patch);
/* Share of its given weight that a patch keeps. */
REGI_API sb_real regi_look_patch_trust(const regi_look *look, int patch);
/* The least trust with which a patch counts. */
REGI_API sb_real regi_look_least_trust(regi_look *look);
/* What share of the given weight is believed, and the mean and 95th percentile of the gaps (m) of what is. */
REGI_API void regi_look_measure(regi_look *look, sb_real *used, sb_real *residual, sb_real *residual_p95);

#endif /* REGI_LOOK_H */

/* ==== src/register/look.c ==== */
/* look: see look.h. */

#include <string.h>


REGI_API void regi_look_take(regi_look_point *p, sb_vec3 at, sb_vec3 normal, sb_real weight, sb_real sd)
{
    memset(p, 0, sizeof *p);
    p->at = at;
    p->normal = regi_cloud_unit(normal);
    p->weight = weight;
    p->sd = sd;
    p->triangle = -1;
}

/* ---- places ---- */

/* 1 when the model's place of a point may be what was seen. */
static int regi_look_is_allowed(const regi_look *look, const regi_look_point *p)
{
    sb_vec3 way = sb_v3_sub(p->at, p->place), view;
    sb_real most = (sb_real)0.02 * look->size;
    if (!(p->weight > 0) || sb_v3_dot(p->normal, p->plane) < 0)
        return 0;
    if (sb_v3_norm(sb_v3_sub(way, sb_v3_scale(p->gap, p->plane))) > most)
        return 0;
    if (!look->has_camera)
        return 1;
    view = sb_v3_sub(look->camera, p->place);
    return sb_v3_dot(view, p->plane) > (sb_real)-0.1 * sb_v3_norm(view);
}

REGI_API void regi_look_place(const regi_look *look, regi_look_point *p)
{
    sb_surface_hit hit;
    p->trust = 0;
    p->gap = 0;
    if (!sb_surface_closest_from(look->tree, p->at, SB_REAL_MAX, p->triangle, &hit)) {
        p->triangle = -1;
        return;
    }
    p->triangle = hit.triangle;
    for (int k = 0; k < 3; k++)
        p->corner[k] = hit.weights[k];
    p->place = hit.point;
    p->plane = sb_surface_normal(look->tree, &hit);
    p->gap = sb_v3_dot(p->plane, sb_v3_sub(p->at, p->place));
    p->trust = regi_look_is_allowed(look, p) ? p->weight : 0;
}

/* Median of what is in sort[count]; 0 for none. */
static sb_real regi_look_median(regi_look *look, int count)
{
    return count > 0 ? regi_cloud_select(look->sort, count, (count - 1) / 2) : 0;
}

/* Median gap of a patch's allowed points. */
static sb_real regi_look_patch_median(regi_look *look, int patch)
{
    int count = 0;
    for (int i = look->patch_start[patch]; i < look->patch_start[patch + 1]; i++)
        if (look->points[i].trust > 0)
            look->sort[count++] = look->points[i].gap;
    return regi_look_median(look, count);
}

/* Noise of the points: 1.48 times the median of their deviations from the medians of their patches, which are left in
 * `off`. A single point has none, so that patches of two or three are counted for what they are worth. */
static void regi_look_estimate_noise(regi_look *look)
{
    int count = 0;
    for (int s = 0; s < look->patch_count; s++) {
        sb_real median = regi_look_patch_median(look, s);
        for (int i = look->patch_start[s]; i < look->patch_start[s + 1]; i++)
            look->points[i].off = look->points[i].gap - median;
    }
    for (int s = 0; s < look->patch_count; s++)
        for (int i = look->patch_start[s]; i < look->patch_start[s + 1]; i++)
            if (look->points[i].trust > 0 && look->patch_start[s + 1] - look->patch_start[s] > 1)
                look->sort[count++] = sb_abs(look->points[i].off);
    look->noise = (sb_real)1.4826 * regi_look_median(look, count);
}

/* Less trust in what is far off. */
static void regi_look_weigh_points(regi_look *look, sb_real early, sb_real medians)
{
    int count = 0;
    sb_real limit;
    for (int i = 0; i < look->point_count; i++)
        if (look->points[i].trust > 0)
            look->sort[count++] = sb_abs(look->points[i].gap);
    limit = sb_max(early, medians * regi_look_median(look, count) + 3 * look->noise);
    for (int i = 0; i < look->point_count && limit > 0; i++) {
        regi_look_point *p = look->points + i;
        sb_real far = p->gap / limit, off = p->off / sb_max(3 * look->noise, (sb_real)0.3 * limit);
        p->trust /= (1 + far * far) * (1 + far * far) * (1 + off * off);
    }
}

REGI_API void regi_look_judge(regi_look *look, sb_real early, sb_real medians)
{
    regi_look_estimate_noise(look);
    regi_look_weigh_points(look, early, medians);
}

/* ---- patches ---- */

/* Shares of a patch's points in its row, and the variance of their mean: of noise, of which three neighbours count as
 * one, and of a share of what the patch is steeper than noise, as at the rim of a dent: that does not average out. */
REGI_API double regi_look_share_patch(regi_look *look, int patch)
{
    const double steep = 0.09;
    double sum = 0, squares = 0, most = 0, spread = 0;
    for (int i = look->patch_start[patch]; i < look->patch_start[patch + 1]; i++) {
        regi_look_point *p = look->points + i;
        p->share = p->sd > 0 ? p->trust / (p->sd * p->sd) : p->trust;
        sum += (double)p->share;
    }
    for (int i = look->patch_start[patch]; i < look->patch_start[patch + 1]; i++) {
        regi_look_point *p = look->points + i;
        double sd = (double)(p->sd > 0 ? p->sd : look->noise);
        p->share = (sb_real)((double)p->share / sum);
        squares += (double)p->share * (double)p->share * sd * sd;
        most += (double)p->share * sd * sd;
        spread += (double)p->share * ((double)p->off * (double)p->off - sd * sd);
    }
    return (3 * squares < most ? 3 * squares : most) + (spread > 0 ? steep * spread : 0);
}

/* Share of its given weight that a patch keeps. */
REGI_API sb_real regi_look_patch_trust(const regi_look *look, int patch)
{
    double kept = 0, all = 0;
    for (int i = look->patch_start[patch]; i < look->patch_start[patch + 1]; i++) {
        kept += (double)look->points[i].trust;
        all += (double)look->points[i].weight;
    }
    return all > 0 ? (sb_real)(kept / all) : 0;
}

REGI_API sb_real regi_look_least_trust(regi_look *look)
{
    int count = 0;
    for (int s = 0; s < look->patch_count; s++) {
        sb_real trust = regi_look_patch_trust(look, s);
        if (trust > 0)
            look->sort[count++] = trust;
    }
    return (sb_real)0.3 * regi_look_median(look, count);
}

/* ---- fit ---- */

REGI_API void regi_look_measure(regi_look *look, sb_real *used, sb_real *residual, sb_real *residual_p95)
{
    double believed = 0, all = 0, sum = 0;
    int count = 0;
    for (int i = 0; i < look->point_count; i++) {
        const regi_look_point *p = look->points + i;
        int good = p->trust > (sb_real)0.25 * p->weight;
        all += (double)p->weight;
        if (!good)
            continue;
        believed += (double)p->weight;
        sum += (double)sb_abs(p->gap);
        look->sort[count++] = sb_abs(p->gap);
    }
    *used = (sb_real)(all > 0 ? believed / all : 0);
    *residual = (sb_real)(count > 0 ? sum / count : 0);
    *residual_p95 = count > 0 ? regi_cloud_select(look->sort, count, (int)(0.95 * (count - 1))) : 0;
}

/* ==== src/register/marks.h ==== */
/* marks: landmarks and lines of an organ (reg_landmark, reg_curve of infer.h): where they are on or in the model, where
 * they are seen, and the gaps between, each along an axis. Floor 6, internal: inferences and trackers make rows of
 * them. */
#ifndef REGI_MARKS_H
#define REGI_MARKS_H


enum { REGI_MARKS_SAMPLES = 32 }; /* of a curve that is seen, at most */

/* A gap of a landmark, or of a place that a curve is seen at: along an axis. */
typedef struct regi_marks_line {
    int points[2];   /* marks: the organ's place is between these, */
    sb_real share;   /* by so much of the second */
    sb_vec3 axis;    /* unit, in space */
    sb_vec3 seen;    /* m */
    double variance; /* m^2 */
} regi_marks_line;

/* Where a curve is seen. */
typedef struct regi_marks_sample {
    sb_vec3 seen, tangent; /* m; unit */
    double variance;       /* m^2 */
    int first, count;      /* marks: corners of the model's line */
} regi_marks_sample;

typedef struct regi_marks {
    sb_real size;           /* m, of the organ */
    int count;              /* marks: landmarks, then corners of the model's lines */
    int landmark_count;     /* of them */
    int curve_count;        /* of the def, also those that are left out */
    int most_samples;       /* that there is room for */
    int *starts;            /* [curve_count + 1] first mark of each curve */
    int *seen;              /* [landmark_count] 1: it is seen; [curve_count] at how many places a curve is */
    sb_embedding_rows rows; /* of the marks in the mesh */
    sb_vec3 *places;        /* [count] m: at rest, then where they are now */
    regi_marks_line *lines; /* [line_count]: three of each landmark seen, then two of each sample that has a place */
    int fixed_count;        /* lines of landmarks */
    int line_count;
    regi_marks_sample *samples; /* [sample_count] */
    int sample_count;
} regi_marks;

/* Landmarks and curves as a caller has them. */
typedef struct regi_marks_def {
    const reg_landmark *landmarks;
    int landmark_count;
    const reg_curve *curves;
    int curve_count;
    int all; /* 1: also those that count nothing now are marks; 0: they are left out */
} regi_marks_def;

/* Counts, and what is of the model: places, lines. SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE (error->node: the landmark or
 * the curve). */
REGI_API sb_result regi_marks_check_model(const regi_marks_def *def, sb_error *error);
/* What is seen of those that count: finite, of a deviation in range, and within `far` (m) of `about`. Others are not
 * looked at. Errors likewise. */
REGI_API sb_result regi_marks_check_seen(const regi_marks_def *def, sb_vec3 about, sb_real far, sb_error *error);
/* count and most_samples: of what is seen now, or, of `all`, of what may be seen. */
REGI_API void regi_marks_count(regi_marks *marks, const regi_marks_def *def, sb_real size);
/* Lines that there may be. */
REGI_API int regi_marks_most_lines(const regi_marks *marks);
REGI_API void regi_marks_layout(regi_marks *marks, sbi_arena *arena);
/* places, at rest, and rows. SB_ERROR_MEMORY, and what sb_embedding_create says. */
REGI_API sb_result regi_marks_place(regi_marks *marks, const regi_marks_def *def, const sb_mesh *mesh,
                                    const sb_allocator *allocator, const sb_jobs *jobs, sb_error *error);
/* Takes what is seen: the lines of landmarks, and samples of curves. */
REGI_API void regi_marks_see(regi_marks *marks, const regi_marks_def *def);
/* Nothing is. */
REGI_API void regi_marks_forget(regi_marks *marks);
/* What follows from `seen`, the first of each landmark's lines, and the samples' places. */
REGI_API void regi_marks_index(regi_marks *marks);
/* Looks for the samples' places on the model's lines where the marks are now (places): the lines of curves. */
REGI_API void regi_marks_follow(regi_marks *marks);

#endif /* REGI_MARKS_H */

/* ==== src/register/marks.c ==== */
/* marks: see marks.h. */

#include <math.h>
#include <string.h>

enum { REGI_MARKS_MOST = 1000 };

/* Places that a curve is seen at are so far apart, in sizes of the organ. */
static const double regi_marks_apart = 0.02;
/* Cosine of the angle up to which a piece of the model's line and one of what is seen may be the same. */
static const double regi_marks_same_way = 0.7;

/* ---- checks ---- */

/* m */
static sb_real regi_marks_length(const sb_vec3 *corners, int count)
{
    sb_real sum = 0;
    for (int i = 0; i + 1 < count; i++)
        sum += sb_v3_norm(sb_v3_sub(corners[i + 1], corners[i]));
    return sum;
}

/* Corners of a line, of the model or seen. */
static sb_result regi_marks_check_corners(const sb_vec3 *corners, int count, int index, sb_error *error)
{
    for (int i = 0; i < count; i++)
        if (!sb_v3_is_finite(corners[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, index, "curve %d is not finite", index);
    if (!(regi_marks_length(corners, count) > 0))
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, index, "curve %d has no length", index);
    return SB_OK;
}

static sb_result regi_marks_check_line(const reg_curve *curve, int index, sb_error *error)
{
    if (!curve->model || curve->model_count < 2 || curve->model_count > REGI_MARKS_MOST)
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, index, "curve %d of %d corners: needs two, and %d at most",
                             index, curve->model ? curve->model_count : 0, (int)REGI_MARKS_MOST);
    return regi_marks_check_corners(curve->model, curve->model_count, index, error);
}

REGI_API sb_result regi_marks_check_model(const regi_marks_def *def, sb_error *error)
{
    sb_result result = SB_OK;
    if (def->landmark_count < 0 || def->landmark_count > REGI_MARKS_MOST ||
        (def->landmark_count > 0 && !def->landmarks))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d landmarks: out of range, or without an array",
                        def->landmark_count);
    for (int i = 0; i < def->landmark_count; i++)
        if (!sb_v3_is_finite(def->landmarks[i].model))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "landmark %d is not finite", i);
    if (def->curve_count < 0 || def->curve_count > REGI_MARKS_MOST || (def->curve_count > 0 && !def->curves))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d curves: out of range, or without an array", def->curve_count);
    for (int i = 0; i < def->curve_count && result == SB_OK; i++)
        result = regi_marks_check_line(def->curves + i, i, error);
    return result;
}

/* SB_ERROR_ARGUMENT for a place that no organ of this size moves to: most often one of other units. */
static sb_result regi_marks_check_near(sb_vec3 seen, sb_vec3 about, sb_real far, const char *what, int index,
                                       sb_error *error)
{
    sb_real way = sb_v3_norm(sb_v3_sub(seen, about));
    if (way <= far)
        return SB_OK;
    return sbi_fail_node(error, SB_ERROR_ARGUMENT, index, "%s %d is seen %g m from the organ: in other units?", what,
                         index, (double)way);
}

static sb_result regi_marks_check_landmark(const reg_landmark *landmark, int index, sb_vec3 about, sb_real far,
                                           sb_error *error)
{
    if (!(landmark->sd >= 0))
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, index, "sd of landmark %d is below 0", index);
    if (!sb_is_finite(landmark->sd))
        return SB_OK;
    if (!sb_v3_is_finite(landmark->seen))
        return sbi_fail_node(error, SB_ERROR_NOT_FINITE, index, "landmark %d is not finite", index);
    return regi_marks_check_near(landmark->seen, about, far, "landmark", index, error);
}

static sb_result regi_marks_check_curve(const reg_curve *curve, int index, sb_vec3 about, sb_real far, sb_error *error)
{
    sb_result result;
    if (!(curve->sd > 0))
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, index, "sd of curve %d is not above 0", index);
    if (!sb_is_finite(curve->sd))
        return SB_OK;
    if (!curve->seen || curve->seen_count < 2)
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, index, "curve %d is seen at %d corners: needs two", index,
                             curve->seen ? curve->seen_count : 0);
    result = regi_marks_check_corners(curve->seen, curve->seen_count, index, error);
    for (int i = 0; i < curve->seen_count && result == SB_OK; i++)
        result = regi_marks_check_near(curve->seen[i], about, far, "curve", index, error);
    return result;
}

REGI_API sb_result regi_marks_check_seen(const regi_marks_def *def, sb_vec3 about, sb_real far, sb_error *error)
{
    sb_result result = SB_OK;
    for (int i = 0; i < def->landmark_count && result == SB_OK; i++)
        result = regi_marks_check_landmark(def->landmarks + i, i, about, far, error);
    for (int i = 0; i < def->curve_count && result == SB_OK; i++)
        result = regi_marks_check_curve(def->curves + i, i, about, far, error);
    return result;
}

/* ---- what there is ---- */

/* At how many places a curve is seen; 0: it counts nothing. */
static int regi_marks_samples_of(const regi_marks *m, const reg_curve *curve)
{
    double wanted;
    if (!sb_is_finite(curve->sd))
        return 0;
    wanted = ceil((double)regi_marks_length(curve->seen, curve->seen_count) / (regi_marks_apart * (double)m->size));
    return wanted < (int)REGI_MARKS_SAMPLES ? (int)wanted : (int)REGI_MARKS_SAMPLES;
}

/* 1: a mark. */
static int regi_marks_has_landmark(const regi_marks_def *def, int index)
{
    return def->all || sb_is_finite(def->landmarks[index].sd);
}

static int regi_marks_has_curve(const regi_marks_def *def, int index)
{
    return def->all || sb_is_finite(def->curves[index].sd);
}

REGI_API void regi_marks_count(regi_marks *m, const regi_marks_def *def, sb_real size)
{
    m->size = size;
    m->landmark_count = m->most_samples = 0;
    m->curve_count = def->curve_count;
    for (int i = 0; i < def->landmark_count; i++)
        m->landmark_count += regi_marks_has_landmark(def, i);
    m->count = m->landmark_count;
    for (int i = 0; i < def->curve_count; i++)
        if (regi_marks_has_curve(def, i)) {
            m->count += def->curves[i].model_count;
            m->most_samples += def->all ? (int)REGI_MARKS_SAMPLES : regi_marks_samples_of(m, def->curves + i);
        }
}

REGI_API int regi_marks_most_lines(const regi_marks *m) { return 3 * m->landmark_count + 2 * m->most_samples; }

REGI_API void regi_marks_layout(regi_marks *m, sbi_arena *arena)
{
    m->starts = (int *)sbi_arena_take(arena, (size_t)m->curve_count + 1, sizeof(int));
    m->seen = (int *)sbi_arena_take(arena, (size_t)m->landmark_count + (size_t)m->curve_count, sizeof(int));
    m->places = (sb_vec3 *)sbi_arena_take(arena, (size_t)m->count, sizeof(sb_vec3));
    m->lines = (regi_marks_line *)sbi_arena_take(arena, (size_t)regi_marks_most_lines(m), sizeof(regi_marks_line));
    m->samples = (regi_marks_sample *)sbi_arena_take(arena, (size_t)m->most_samples, sizeof(regi_marks_sample));
}

REGI_API sb_result regi_marks_place(regi_marks *m, const regi_marks_def *def, const sb_mesh *mesh,
                                    const sb_allocator *allocator, const sb_jobs *jobs, sb_error *error)
{
    sb_embedding_def embed = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_result result;
    int mark = 0;
    if (m->count == 0)
        return SB_OK;
    for (int i = 0; i < def->landmark_count; i++)
        if (regi_marks_has_landmark(def, i))
            m->places[mark++] = def->landmarks[i].model;
    m->starts[0] = mark;
    for (int i = 0; i < def->curve_count; i++) {
        const reg_curve *curve = def->curves + i;
        if (regi_marks_has_curve(def, i)) {
            memcpy(m->places + mark, curve->model, (size_t)curve->model_count * sizeof *curve->model);
            mark += curve->model_count;
        }
        m->starts[i + 1] = mark;
    }
    embed.mesh = mesh;
    embed.points = m->places;
    embed.point_count = m->count;
    embed.kind = SB_EMBED_PLAIN;
    embed.max_distance = (sb_real)0.25 * m->size;
    embed.allocator = *allocator;
    embed.jobs = *jobs;
    result = sb_embedding_create(&embed, &embedding, error);
    if (result == SB_OK)
        result = sb_embedding_mapping(embedding, allocator, &m->rows, error);
    sb_embedding_destroy(embedding);
    return result;
}

/* ---- what is seen ---- */

REGI_API void regi_marks_index(regi_marks *m)
{
    m->fixed_count = m->sample_count = 0;
    for (int mark = 0; mark < m->landmark_count; mark++)
        for (int k = 0; k < 3 && m->seen[mark]; k++) {
            regi_marks_line *line = m->lines + m->fixed_count++;
            *line = line[-k];
            line->points[0] = line->points[1] = mark;
            line->share = 0;
            line->axis = sb_v3(k == 0, k == 1, k == 2);
        }
    for (int i = 0; i < m->curve_count; i++)
        for (int k = 0; k < m->seen[m->landmark_count + i]; k++) {
            regi_marks_sample *sample = m->samples + m->sample_count++;
            sample->first = m->starts[i];
            sample->count = m->starts[i + 1] - m->starts[i];
        }
    m->line_count = m->fixed_count;
}

REGI_API void regi_marks_forget(regi_marks *m)
{
    for (int i = 0; i < m->landmark_count + m->curve_count; i++)
        m->seen[i] = 0;
    regi_marks_index(m);
}

/* The middles of `count` pieces of one length that what is seen of a curve is cut into. */
static void regi_marks_sample_curve(const reg_curve *curve, int count, regi_marks_sample *samples)
{
    sb_real length = regi_marks_length(curve->seen, curve->seen_count), behind = 0;
    int corner = 0;
    for (int k = 0; k < count; k++) {
        sb_real at = length * ((sb_real)k + (sb_real)0.5) / (sb_real)count;
        sb_vec3 along = sb_v3_sub(curve->seen[corner + 1], curve->seen[corner]);
        sb_real way = sb_v3_norm(along);
        while (corner + 2 < curve->seen_count && behind + way < at) {
            behind += way;
            corner++;
            along = sb_v3_sub(curve->seen[corner + 1], curve->seen[corner]);
            way = sb_v3_norm(along);
        }
        samples[k].tangent = sb_v3_scale(way > 0 ? 1 / way : 0, along);
        samples[k].seen = sb_v3_madd(curve->seen[corner], sb_min(at - behind, way), samples[k].tangent);
        samples[k].variance = (double)curve->sd * (double)curve->sd;
    }
}

REGI_API void regi_marks_see(regi_marks *m, const regi_marks_def *def)
{
    int mark = 0, seen = 0, samples = 0;
    for (int i = 0; i < def->landmark_count; i++) {
        const reg_landmark *landmark = def->landmarks + i;
        int counts = sb_is_finite(landmark->sd);
        if (counts) {
            m->lines[3 * seen].seen = landmark->seen;
            m->lines[3 * seen++].variance = (double)landmark->sd * (double)landmark->sd;
        }
        if (regi_marks_has_landmark(def, i))
            m->seen[mark++] = counts;
    }
    for (int i = 0; i < def->curve_count; i++) {
        int count = regi_marks_samples_of(m, def->curves + i);
        if (count > 0)
            regi_marks_sample_curve(def->curves + i, count, m->samples + samples);
        m->seen[m->landmark_count + i] = count;
        samples += count;
    }
    regi_marks_index(m);
}

/* The nearest place on the model's line where that goes the way that is seen: by a share of the way from the mark that
 * is told to the next one. -1: there is none. */
static int regi_marks_find_on_curve(const regi_marks *m, const regi_marks_sample *sample, sb_real *share)
{
    sb_real nearest = SB_REAL_MAX;
    int found = -1;
    for (int i = sample->first; i + 1 < sample->first + sample->count; i++) {
        sb_vec3 from = m->places[i], way = sb_v3_sub(m->places[i + 1], from), off;
        sb_real length = sb_v3_norm(way), at;
        if (!(length > 0) || !(sb_abs(sb_v3_dot(way, sample->tangent)) > (sb_real)regi_marks_same_way * length))
            continue;
        at = sb_v3_dot(sb_v3_sub(sample->seen, from), way) / (length * length);
        at = sb_min(sb_max(at, 0), 1);
        off = sb_v3_sub(sample->seen, sb_v3_madd(from, at, way));
        if (sb_v3_dot(off, off) < nearest) {
            nearest = sb_v3_dot(off, off);
            *share = at;
            found = i;
        }
    }
    return found;
}

/* The two lines across the model's one, from where a sample has its place. */
static void regi_marks_add_sample(regi_marks *m, const regi_marks_sample *sample, int from, sb_real share)
{
    regi_marks_line *line = m->lines + m->line_count;
    sb_vec3 way = sb_v3_sub(m->places[from + 1], m->places[from]);
    sb_vec3 along = sb_v3_scale(1 / sb_v3_norm(way), way);
    line->points[0] = from;
    line->points[1] = from + 1;
    line->share = share;
    line->axis = sb_v3_perpendicular(along);
    line->seen = sample->seen;
    line->variance = sample->variance;
    line[1] = line[0];
    line[1].axis = sb_v3_cross(along, line->axis);
    m->line_count += 2;
}

REGI_API void regi_marks_follow(regi_marks *m)
{
    m->line_count = m->fixed_count;
    for (int i = 0; i < m->sample_count; i++) {
        sb_real share = 0;
        int from = regi_marks_find_on_curve(m, m->samples + i, &share);
        if (from >= 0)
            regi_marks_add_sample(m, m->samples + i, from, share);
    }
}

/* ==== src/register/infer_private.h ==== */
/* infer_private: what is inside a reg_infer. Floor 6, internal: infer_rows.c looks at the target, infer_prior.c chooses
 * the prior, infer_round.c moves the organ, infer_draws.c says how sure that is, infer.c makes it all. */
#ifndef REG_INFER_PRIVATE_H
#define REG_INFER_PRIVATE_H


enum {
    REGI_INFER_POSE = 6,    /* moves along the axes and turns about them; a seventh column of the pose is an offset of
                             * all points across the surface: of a scan, of a segmentation, or of facets, which bulge
                             * less than what they stand for. Without it they would be the work of a pressure */
    REGI_INFER_WEIGHT = 3,  /* columns of the weight, after those of tractions; then that of a pressure */
    REGI_INFER_REGIONS = 40 /* of unknown stiffness */
};

/* Length of the tractions, in shares of the size: about that of tools and hands. Longer ones, which evidence may well
 * prefer, need so large a scale for what is local that the organ bends by far too much where it is not seen. */
#define REGI_INFER_LENGTH 0.06

/* What the prior of the loads is like. */
typedef struct regi_infer_choice {
    double gravity;  /* sd of the weight, in shares of scale times area */
    double pressure; /* and of that on what is pressed, in shares of scale */
    double earned;   /* log evidence that it has over none */
    double misfit;   /* m */
    double scale;    /* Pa */
    double evidence; /* log */
    int is_local;    /* local[] of the inference counts */
} regi_infer_choice;

struct reg_infer {
    sb_allocator allocator;
    const reg_infer_def *def; /* during the run */
    reg_model *model;
    regi_response response; /* where the organ was before the last round */
    sbi_between *between;   /* lefts: data; rights: control points */
    regi_look look;
    regi_gauss gauss;
    regi_infer_choice choice;
    reg_quality quality;
    void *memory;
    int node_count;
    int loads;           /* 3 per control point, the weight's, and that of a pressure where there may be one */
    double begun;        /* on the clock */
    int *patch_of;       /* [count of data] patch, or -1 - line */
    double *averaged;    /* [data] m^2: the part of the variance that averages out */
    regi_marks marks;    /* landmarks and curves */
    double *raw;         /* [loads][gauss.most] responses of data, then resultants, to unit tractions and weight */
    int rooted;          /* root is of tractions alike everywhere: 1, of `local`: 2, of none of them: 0 */
    double *root;        /* [c][c] of the present prior, lower triangle */
    double *turned_root; /* [c][c] its transpose */
    double *tile;        /* [most or c, the larger][REGI_BLOCK_WIDTH] scratch */
    double *extended;    /* [most][most] gram of responses to tractions with their resultants */
    double *local, *trial_local; /* [c] */
    double *energy;              /* [c + 6] */
    double *c;                   /* [loads] found, in the gauss' units */
    double *draw;                /* [loads] */
    double *datum;               /* [most] scratch */
    double *chances;             /* [DRAWS][loads + REGI_GAUSS_POSES + most] */
    sb_vec3 *tractions;          /* [c] scratch */
    sb_vec3 *pressing;          /* [c] traction of the unit pressure where the organ is now; NULL: nothing is pressed */
    double *drift;              /* [REGI_RESPONSE_MODES][most] what modes as forces do to data, then forces that stop
                                 * their drift */
    sb_vec3 *row;               /* [REG_INFER_DRAWS][nodes] */
    sb_vec3 *skin;              /* [skin nodes] where they are (m) */
    sb_vec3 *forces;            /* [nodes] found (N) */
    sb_vec3 *increment, *trial; /* [nodes] */
    sb_vec3 *before;            /* [nodes] where they were before the last round (m) */
    sb_vec3 *shape;             /* [nodes] displacements found (m) */
    sb_vec3 *errors;            /* [DRAWS][nodes] of draws (m), calibrated */
    sb_real *expected;          /* [nodes] m */
    sb_vec3 *cell_force;        /* [cells][nodes per cell] internal forces (N) */
    sb_vec3 *poisson_force;     /* [nodes] what 0.02 of Poisson's ratio do to them (N) */
    sb_real *region;            /* [cells][REGIONS] shares */
    double pose_sd[REGI_INFER_POSE]; /* m, rad */
    double pose[REGI_INFER_POSE];    /* reached: m, rad */
    double next[REGI_GAUSS_POSES];   /* found in this round; the offset last (m) */
    sb_real spacing;                 /* m: of the patches */
    double alike;                    /* patches that count as one, >= 1 */
    double left;                     /* the same before that bound */
    double temper;                   /* share of the evidence that counts, (0, 1] */
};

/* ---- infer ---- */
/* Data that there may be. */
REGI_API int regi_infer_most_data(const reg_infer *infer);
/* Points or a surface, a camera, numbers in range. SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE (error->node). */
REGI_API sb_result regi_infer_check_points(const reg_points *target, sb_error *error);
/* 1: orthonormal, of determinant 1, finite. */
REGI_API int regi_infer_is_motion(const reg_rigid *motion);

/* ---- infer_rows ---- */
/* Seconds on the caller's clock, 0 without one. */
REGI_API double regi_infer_now(const reg_infer *infer);
/* Groups the points into patches: fills the look. SB_ERROR_MEMORY. */
REGI_API sb_result regi_infer_group(reg_infer *infer, int patches, sb_error *error);
/* Mean distance between patches that are neighbours (m). */
REGI_API sb_real regi_infer_spacing(const reg_infer *infer);
/* Looks for the points' places on the model where it is now, trusts them, and lists the data: gauss.count, patch_of,
 * averaged. Returns how many patches count. */
REGI_API int regi_infer_look(reg_infer *infer, int round);
/* Adds the row of a datum to row[nodes], and tells its gap and what the pose does to it (per m and rad). */
REGI_API void regi_infer_row(const reg_infer *infer, int datum, sb_vec3 *row, double *gap,
                             double pose[REGI_INFER_POSE]);
/* What displacements u[nodes] do to a datum (m). */
REGI_API double regi_infer_measure(const reg_infer *infer, int datum, const sb_vec3 *u);

/* ---- infer_prior ---- */
/* What a model cannot follow (m). */
REGI_API double regi_infer_least_misfit(const reg_model *model);
/* Variances of the data for a misfit (m). */
REGI_API void regi_infer_set_misfit(reg_infer *infer, double misfit);
/* Columns and resultants of the gauss for a choice. 0: none. */
REGI_API int regi_infer_set_prior(reg_infer *infer, const regi_infer_choice *choice);
/* Chooses length, weight, misfit, scale and local scale; the gauss has them. 0: it cannot. */
REGI_API int regi_infer_choose(reg_infer *infer);
/* Tractions [c] (Pa), less those of the pressure, of loads in the gauss' units. */
REGI_API void regi_infer_unfold(const reg_infer *infer, const double *c, sb_vec3 *tractions);
/* The pressure among them (Pa); 0: there is none. */
REGI_API double regi_infer_pressure(const reg_infer *infer, const double *c);
/* Forces [nodes] (N) of loads in the gauss' units. Uses `tractions`. */
REGI_API void regi_infer_load(reg_infer *infer, const double *c, sb_vec3 *forces);

/* ---- infer_respond ---- */
/* Responses, gaps and resultants of the data at hand. */
REGI_API void regi_infer_respond(reg_infer *infer);

/* ---- infer_round ---- */
REGI_API sb_result regi_infer_round(reg_infer *infer, int round, sb_error *error);
/* Moves the organ to where exact landmarks are met, by what the last round is linear about. */
REGI_API sb_result regi_infer_meet(reg_infer *infer);

/* ---- infer_draws ---- */
REGI_API sb_result regi_infer_tell(reg_infer *infer, sb_error *error);

#endif /* REG_INFER_PRIVATE_H */

/* ==== src/register/infer_rows.c ==== */
/* infer_rows: the target's points, their patches, places of the model, and trust. */

#include <string.h>


REGI_API double regi_infer_now(const reg_infer *infer) { return infer->def->clock ? infer->def->clock() : 0.0; }

/* ---- patches ---- */

/* Centres spread evenly over the points, each point to the closest. at: the centres, then. */
static sb_result regi_infer_cut(reg_infer *f, int patches, sb_vec3 *at, int *chosen, int *count, sb_error *error)
{
    reg_kdtree *tree = NULL;
    sb_result result;
    for (int i = 0; i < f->look.point_count; i++)
        at[i] = f->look.points[i].at;
    f->look.patch_count = reg_cloud_spread(at, f->look.point_count, patches, chosen, f->look.sort);
    for (int s = 0; s < f->look.patch_count; s++)
        at[s] = f->look.points[chosen[s]].at;
    result = reg_kdtree_create(at, f->look.patch_count, &f->allocator, &tree, error);
    if (result != SB_OK)
        return result;
    memset(count, 0, (size_t)(f->look.patch_count + 1) * sizeof *count);
    for (int i = 0; i < f->look.point_count; i++) {
        f->look.points[i].patch = reg_kdtree_nearest(tree, f->look.points[i].at, SB_REAL_MAX, NULL);
        f->look.points[i].patch =
            f->look.points[i].patch < 0 ? 0 : f->look.points[i].patch; /* too far away for squares */
        count[f->look.points[i].patch + 1]++;
    }
    reg_kdtree_destroy(tree);
    return SB_OK;
}

/* A patch's centre is the first of its points, whatever order they came in. */
static void regi_infer_put_centres_first(reg_infer *f, const sb_vec3 *at)
{
    for (int s = 0; s < f->look.patch_count; s++) {
        regi_look_point *first = f->look.points + f->look.patch_start[s], centre;
        for (int i = f->look.patch_start[s]; i < f->look.patch_start[s + 1]; i++) {
            sb_vec3 off = sb_v3_sub(f->look.points[i].at, at[s]);
            if (sb_v3_dot(off, off) > 0)
                continue;
            centre = f->look.points[i];
            f->look.points[i] = *first;
            *first = centre;
            break;
        }
    }
}

/* Points sorted by patch. */
REGI_API sb_result regi_infer_group(reg_infer *f, int patches, sb_error *error)
{
    size_t n = (size_t)f->look.point_count;
    regi_look_point *sorted = (regi_look_point *)sbi_alloc(&f->allocator, n, sizeof *sorted);
    sb_vec3 *at = (sb_vec3 *)sbi_alloc(&f->allocator, n, sizeof *at);
    int *chosen = (int *)sbi_alloc(&f->allocator, (size_t)patches, sizeof *chosen);
    sb_result result = SB_OK;
    if (!sorted || !at || !chosen)
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the patches of %d points", f->look.point_count);
    if (result == SB_OK)
        result = regi_infer_cut(f, patches, at, chosen, f->look.patch_start, error);
    if (result == SB_OK) {
        for (int s = 0; s < f->look.patch_count; s++)
            f->look.patch_start[s + 1] += f->look.patch_start[s];
        for (int i = 0; i < f->look.point_count; i++)
            sorted[f->look.patch_start[f->look.points[i].patch]++] = f->look.points[i];
        memmove(f->look.patch_start + 1, f->look.patch_start, (size_t)f->look.patch_count * sizeof(int));
        f->look.patch_start[0] = 0;
        memcpy(f->look.points, sorted, n * sizeof *sorted);
        regi_infer_put_centres_first(f, at);
    }
    sbi_free(&f->allocator, chosen);
    sbi_free(&f->allocator, at);
    sbi_free(&f->allocator, sorted);
    return result;
}

REGI_API sb_real regi_infer_spacing(const reg_infer *f)
{
    double sum = 0;
    int count = 0;
    for (int s = 0; s < f->look.patch_count; s++) {
        sb_real nearest = SB_REAL_MAX;
        for (int t = 0; t < f->look.patch_count; t++) {
            sb_vec3 d = sb_v3_sub(f->look.points[f->look.patch_start[s]].at, f->look.points[f->look.patch_start[t]].at);
            nearest = t == s ? nearest : sb_min(nearest, sb_v3_dot(d, d));
        }
        sum += nearest < SB_REAL_MAX ? (double)sb_sqrt(nearest) : 0;
        count++;
    }
    return count > 0 ? (sb_real)(sum / count) : 0;
}

/* ---- data ---- */

static int regi_infer_list_data(reg_infer *f)
{
    int patches;
    sb_real least = regi_look_least_trust(&f->look);
    f->gauss.count = 0;
    for (int s = 0; s < f->look.patch_count; s++)
        if (regi_look_patch_trust(&f->look, s) > least) {
            f->averaged[f->gauss.count] = regi_look_share_patch(&f->look, s);
            f->patch_of[f->gauss.count++] = s;
        }
    patches = f->gauss.count;
    for (int k = 0; k < f->marks.line_count; k++) {
        f->averaged[f->gauss.count] = f->marks.lines[k].variance;
        f->patch_of[f->gauss.count++] = -1 - k;
    }
    return patches;
}

/* The limit of what is believed begins with what loads may well do, and halves each round, down to what the others
 * scatter, but no farther than to what a coarse model may be off by: a dent is followed before what is left is taken
 * for no organ. */
static sb_real regi_infer_early_limit(const reg_infer *f, int round)
{
    sb_real early = (sb_real)0.08 * f->model->size;
    for (int k = 0; k < round; k++)
        early *= (sb_real)0.5;
    return sb_max(early, (sb_real)0.01 * f->model->size);
}

REGI_API int regi_infer_look(reg_infer *f, int round)
{
    const reg_model *m = f->model;
    sb_mapping_apply(&m->rows.mapping, sb_body_positions(m->body), f->skin);
    if (sb_surface_move(m->tree, f->skin, &m->jobs, NULL) != SB_OK)
        return 0;
    for (int i = 0; i < f->look.point_count; i++)
        regi_look_place(&f->look, f->look.points + i);
    regi_look_judge(&f->look, regi_infer_early_limit(f, round), round < 2 ? 4 : 6);
    if (f->marks.sample_count > 0)
        sb_mapping_apply(&f->marks.rows.mapping, sb_body_positions(m->body), f->marks.places);
    regi_marks_follow(&f->marks);
    return regi_infer_list_data(f);
}

/* ---- rows ---- */

/* Adds line, shared out by one row of a mapping. */
static void regi_infer_add(const sb_mapping *mapping, int point, sb_vec3 line, sb_vec3 *row)
{
    for (int k = mapping->row_start[point]; k < mapping->row_start[point + 1]; k++)
        row[mapping->nodes[k]] = sb_v3_madd(row[mapping->nodes[k]], mapping->weights[k], line);
}

static void regi_infer_add_pose(const reg_infer *f, sb_vec3 place, sb_vec3 line, double pose[REGI_INFER_POSE])
{
    sb_vec3 turn = sb_v3_cross(sb_v3_sub(place, f->response.centre), line);
    const sb_real slope[REGI_INFER_POSE] = {line.x, line.y, line.z, turn.x, turn.y, turn.z};
    for (int k = 0; k < REGI_INFER_POSE; k++)
        pose[k] += (double)slope[k];
}

/* Adds a line's row to row[nodes], and tells its gap and the place that it is of (m). */
static void regi_infer_add_line(const reg_infer *f, const regi_marks_line *line, sb_vec3 *row, double *gap,
                                sb_vec3 *place)
{
    const sb_mapping *mapping = &f->marks.rows.mapping;
    const sb_vec3 *x = sb_body_positions(f->model->body);
    *place = sb_v3(0, 0, 0);
    for (int end = 0; end < 2; end++) {
        sb_real part = end ? line->share : 1 - line->share;
        for (int k = mapping->row_start[line->points[end]]; k < mapping->row_start[line->points[end] + 1]; k++) {
            int node = mapping->nodes[k];
            *place = sb_v3_madd(*place, part * mapping->weights[k], x[node]);
            row[node] = sb_v3_madd(row[node], part * mapping->weights[k], line->axis);
        }
    }
    *gap = (double)sb_v3_dot(sb_v3_sub(line->seen, *place), line->axis);
}

REGI_API void regi_infer_row(const reg_infer *f, int datum, sb_vec3 *row, double *gap, double pose[REGI_INFER_POSE])
{
    int patch = f->patch_of[datum];
    *gap = 0;
    memset(pose, 0, REGI_INFER_POSE * sizeof *pose);
    if (patch < 0) {
        const regi_marks_line *line = f->marks.lines + (-1 - patch);
        sb_vec3 place;
        regi_infer_add_line(f, line, row, gap, &place);
        regi_infer_add_pose(f, place, line->axis, pose);
        return;
    }
    for (int i = f->look.patch_start[patch]; i < f->look.patch_start[patch + 1]; i++) {
        const regi_look_point *p = f->look.points + i;
        const int *corners = p->triangle < 0 ? NULL : f->model->skin.elements + 3 * (size_t)p->triangle;
        sb_vec3 line = sb_v3_scale(p->share, p->plane);
        if (!(p->share > 0) || !corners)
            continue;
        *gap += (double)(p->share * p->gap);
        regi_infer_add_pose(f, p->place, line, pose);
        for (int k = 0; k < 3; k++)
            regi_infer_add(&f->model->rows.mapping, corners[k], sb_v3_scale(p->corner[k], line), row);
    }
}

static double regi_infer_measure_point(const sb_mapping *mapping, int point, sb_vec3 line, const sb_vec3 *u)
{
    sb_real sum = 0;
    for (int k = mapping->row_start[point]; k < mapping->row_start[point + 1]; k++)
        sum += mapping->weights[k] * sb_v3_dot(line, u[mapping->nodes[k]]);
    return (double)sum;
}

REGI_API double regi_infer_measure(const reg_infer *f, int datum, const sb_vec3 *u)
{
    int patch = f->patch_of[datum];
    double sum = 0;
    if (patch < 0) {
        const regi_marks_line *line = f->marks.lines + (-1 - patch);
        return (double)(1 - line->share) *
                   regi_infer_measure_point(&f->marks.rows.mapping, line->points[0], line->axis, u) +
               (double)line->share * regi_infer_measure_point(&f->marks.rows.mapping, line->points[1], line->axis, u);
    }
    for (int i = f->look.patch_start[patch]; i < f->look.patch_start[patch + 1]; i++) {
        const regi_look_point *p = f->look.points + i;
        for (int k = 0; k < 3 && p->share > 0 && p->triangle >= 0; k++)
            sum += regi_infer_measure_point(&f->model->rows.mapping,
                                            f->model->skin.elements[3 * (size_t)p->triangle + (size_t)k],
                                            sb_v3_scale(p->share * p->corner[k], p->plane), u);
    }
    return sum;
}

/* ==== src/register/infer_prior.c ==== */
/* infer_prior: which loads explain what is seen: weight, misfit, scale and places, by their evidence. */

#include <math.h>
#include <string.h>

enum { REGI_INFER_SIZES = 4, REGI_INFER_MISFITS = 5, REGI_INFER_LOCAL = 4 };

/* How far about a patch others are off alike, in distances of the model's nodes. */
#define REGI_INFER_ALIKE 1.65

/* Places of their own must explain more than loads everywhere by so many nats, tempered. */
static const double regi_infer_earned = 3;

REGI_API void regi_infer_set_misfit(reg_infer *f, double misfit)
{
    for (int i = 0; i < f->gauss.count; i++)
        f->gauss.variance[i] = f->averaged[i] + (f->patch_of[i] < 0 ? 0 : f->alike * misfit * misfit);
}

/* ---- columns ---- */

/* root of tractions with a local scale or alike everywhere, and turned_root: they last while the scale does. 0: there
 * is none. */
static int regi_infer_find_root(reg_infer *f, int is_local)
{
    int c = f->model->prior.control_count;
    if (f->rooted == 1 + is_local)
        return 1;
    f->rooted = 0;
    if (!regi_prior_root(&f->model->prior, REGI_INFER_LENGTH, is_local ? f->local : NULL, f->root))
        return 0;
    f->rooted = 1 + is_local;
    for (int j = 0; j < c; j++)
        for (int k = 0; k < c; k++)
            f->turned_root[(size_t)k * (size_t)c + (size_t)j] = f->root[(size_t)j * (size_t)c + (size_t)k];
    return 1;
}

/* columns of tractions along an axis for data first.. of a tile's width: what they respond to goes into a tile, which
 * stays near while all columns are made of it. */
static void regi_infer_fill_strip(reg_infer *f, int axis, int first, int width)
{
    int c = f->model->prior.control_count;
    size_t m = (size_t)f->gauss.most;
    for (int j = 0; j < c; j++)
        memcpy(f->tile + (size_t)j * REGI_BLOCK_WIDTH, f->raw + (size_t)(3 * j + axis) * m + (size_t)first,
               (size_t)width * sizeof *f->tile);
    for (int k = 0; k < c; k += 2 * REGI_BLOCK_ROWS) {
        int have = sbi_min_int(2 * REGI_BLOCK_ROWS, c - k);
        double *columns = f->gauss.columns + (size_t)(3 * k + axis) * m + (size_t)first;
        regi_block block = {NULL, NULL, REGI_BLOCK_WIDTH, 1, 0, 0, 0};
        block.wide = f->gauss.wide;
        block.left = f->tile + (size_t)k * REGI_BLOCK_WIDTH; /* turned_root is 0 before its diagonal */
        block.right = f->turned_root + (size_t)k * (size_t)c + (size_t)k;
        block.right_stride = (size_t)c;
        block.depth = c - k;
        for (int r = 0; r < have; r++)
            memset(columns + (size_t)r * 3 * m, 0, (size_t)width * sizeof *columns);
        regi_block_add(&block, width, have, 1, columns, 3 * m);
    }
}

/* columns of tractions for the root at hand, with the resultants below the data. */
static void regi_infer_fill_tractions(reg_infer *f)
{
    int rows = f->gauss.count + f->gauss.exact;
    for (int axis = 0; axis < 3; axis++)
        for (int i = 0; i < rows; i += REGI_BLOCK_WIDTH)
            regi_infer_fill_strip(f, axis, i, sbi_min_int(REGI_BLOCK_WIDTH, rows - i));
}

/* Deviation of a load that acts on the organ as a whole, in scales: of the weight (m^2), or of a pressure. */
static double regi_infer_whole_unit(const reg_infer *f, const regi_infer_choice *choice, int load)
{
    int weights = load < 3 * f->model->prior.control_count + REGI_INFER_WEIGHT;
    return weights ? choice->gravity * f->model->prior.area : choice->pressure;
}

/* columns of the weight and of a pressure. */
static void regi_infer_fill_whole(reg_infer *f, const regi_infer_choice *choice)
{
    int rows = f->gauss.count + f->gauss.exact;
    size_t m = (size_t)f->gauss.most;
    for (int load = 3 * f->model->prior.control_count; load < f->loads; load++) {
        double unit = regi_infer_whole_unit(f, choice, load);
        for (int i = 0; i < rows; i++)
            f->gauss.columns[(size_t)load * m + (size_t)i] = unit * f->raw[(size_t)load * m + (size_t)i];
    }
}

/* Columns of tractions are there: the others of a choice, loads without resultants, gram and variances. */
static void regi_infer_bind_prior(reg_infer *f, const regi_infer_choice *choice)
{
    regi_gauss *g = &f->gauss;
    g->loads = f->loads;
    regi_infer_fill_whole(f, choice);
    for (int e = 0; e < g->exact; e++)
        for (int b = 0; b < g->loads; b++)
            g->resultants[(size_t)e * (size_t)g->most_loads + (size_t)b] =
                g->columns[(size_t)b * (size_t)g->most + (size_t)(g->count + e)];
    regi_gauss_bind(g);
    regi_gauss_multiply(g);
    regi_infer_set_misfit(f, choice->misfit);
    g->scale = choice->scale;
}

/* The columns of a choice; loads without resultants. */
REGI_API int regi_infer_set_prior(reg_infer *f, const regi_infer_choice *choice)
{
    if (!regi_infer_find_root(f, choice->is_local))
        return 0;
    regi_infer_fill_tractions(f);
    regi_infer_bind_prior(f, choice);
    return 1;
}

REGI_API void regi_infer_unfold(const reg_infer *f, const double *loads, sb_vec3 *tractions)
{
    int c = f->model->prior.control_count;
    for (int j = 0; j < c; j++) {
        double sum[3] = {0, 0, 0};
        for (int k = 0; k <= j; k++)
            for (int axis = 0; axis < 3; axis++)
                sum[axis] += f->root[(size_t)j * (size_t)c + (size_t)k] * loads[3 * k + axis];
        tractions[j] = sb_v3((sb_real)sum[0], (sb_real)sum[1], (sb_real)sum[2]);
    }
}

REGI_API double regi_infer_pressure(const reg_infer *f, const double *loads)
{
    return f->pressing ? regi_infer_whole_unit(f, &f->choice, f->loads - 1) * loads[f->loads - 1] : 0;
}

REGI_API void regi_infer_load(reg_infer *f, const double *loads, sb_vec3 *forces)
{
    int c = f->model->prior.control_count;
    double unit = regi_infer_whole_unit(f, &f->choice, 3 * c), pressure = regi_infer_pressure(f, loads);
    const double *w = loads + 3 * c;
    regi_infer_unfold(f, loads, f->tractions);
    for (int j = 0; f->pressing && j < c; j++)
        f->tractions[j] = sb_v3_madd(f->tractions[j], (sb_real)pressure, f->pressing[j]);
    regi_prior_forces(&f->model->prior, f->tractions,
                      sb_v3((sb_real)(unit * w[0]), (sb_real)(unit * w[1]), (sb_real)(unit * w[2])), forces);
}

/* ---- evidence on the grid ---- */

/* Columns of tractions that are alike everywhere; extended: their gram, resultants included. */
static int regi_infer_extend(reg_infer *f)
{
    regi_gauss *g = &f->gauss;
    int count = g->count, rows = count + g->exact;
    if (!regi_infer_find_root(f, 0))
        return 0;
    regi_infer_fill_tractions(f);
    g->count = rows;
    g->loads = 3 * f->model->prior.control_count;
    regi_gauss_multiply(g);
    g->count = count;
    g->loads = f->loads;
    memcpy(f->extended, g->gram, (size_t)rows * (size_t)g->most * sizeof(double));
    return 1;
}

/* gram: that of `extended`, a weight and a pressure, among loads without resultants: its last rows are eliminated. */
static void regi_infer_weigh_gram(reg_infer *f, const regi_infer_choice *choice)
{
    regi_gauss *g = &f->gauss;
    size_t m = (size_t)g->most;
    int rows = g->count + g->exact;
    regi_infer_fill_whole(f, choice);
    memcpy(g->gram, f->extended, (size_t)rows * m * sizeof(double));
    for (int load = 3 * f->model->prior.control_count; load < f->loads; load++) {
        const double *w = g->columns + (size_t)load * m;
        for (int i = 0; i < rows; i++)
            for (int j = i; j < rows; j++)
                g->gram[(size_t)i * m + (size_t)j] += w[i] * w[j];
    }
    for (int e = rows - 1; e >= g->count; e--) {
        double pivot = g->gram[(size_t)e * m + (size_t)e], *column = g->scratch;
        for (int i = 0; i < e; i++)
            column[i] = g->gram[(size_t)i * m + (size_t)e];
        for (int i = 0; i < e && pivot > 0; i++) {
            double share = column[i] / pivot, *row = g->gram + (size_t)i * m;
            for (int j = i; j < e; j++)
                row[j] -= share * column[j];
        }
    }
}

/* Scale and evidence of the gram at hand for a misfit; 0: there is none. */
static int regi_infer_weigh_misfit(reg_infer *f, regi_infer_choice *choice)
{
    regi_infer_set_misfit(f, choice->misfit);
    if (!regi_gauss_spectrum(&f->gauss))
        return 0;
    choice->scale = regi_gauss_best_scale(&f->gauss, &choice->evidence);
    return 1;
}

/* What the model cannot follow (m), for `spacing` s: a quarter of s^1.5 in sizes, as measured on models of 60 to 1,500
 * nodes; beyond 0.006 nothing is gained. With less, errors of a coarse model look like loads, which bend the organ as a
 * whole: a dent narrower than a cell put it off by up to 2.7 times what the rigid start was. */
REGI_API double regi_infer_least_misfit(const reg_model *model)
{
    double size = (double)model->size, cell = model->spacing / size, share = 0.25 * cell * sqrt(cell);
    return size * (share < 1e-3 ? 1e-3 : share > 6e-3 ? 6e-3 : share);
}

/* The best misfit for the gram at hand, which has been reduced. */
static int regi_infer_search_misfit(reg_infer *f, regi_infer_choice *best)
{
    static const double shares[REGI_INFER_MISFITS] = {1.02, 1.06, 1.23, 1.74, 3.03};
    regi_infer_choice trial = *best;
    for (int k = 0; k < REGI_INFER_MISFITS; k++) {
        trial.misfit = shares[k] * regi_infer_least_misfit(f->model);
        if (!regi_infer_weigh_misfit(f, &trial))
            return 0;
        if (k == 0 || trial.evidence > best->evidence)
            *best = trial;
    }
    return 1;
}

/* The best size of the weight, or of the pressure, at the misfit at hand: `best`, and none, which it has so far. */
static int regi_infer_search_whole(reg_infer *f, int presses, regi_infer_choice *best)
{
    static const double sizes[REGI_INFER_SIZES] = {1, 10, 100, 1000};
    const regi_infer_choice none = *best;
    for (int k = 0; k < (presses ? REGI_INFER_SIZES : REGI_INFER_SIZES - 1); k++) {
        regi_infer_choice trial = none;
        *(presses ? &trial.pressure : &trial.gravity) = sizes[k];
        regi_infer_weigh_gram(f, &trial);
        regi_gauss_reduce(&f->gauss);
        if (!regi_infer_weigh_misfit(f, &trial))
            return 0;
        trial.earned = presses ? trial.evidence - none.evidence : 0;
        if (trial.evidence > best->evidence)
            *best = trial;
    }
    return 1;
}

/* Weight, pressure and misfit: the misfit with neither, then each of them; the misfit is looked for again with them. */
static int regi_infer_search(reg_infer *f, regi_infer_choice *best)
{
    memset(best, 0, sizeof *best);
    if (!regi_infer_extend(f))
        return 0;
    regi_infer_weigh_gram(f, best);
    regi_gauss_reduce(&f->gauss);
    if (!regi_infer_search_misfit(f, best) || (f->def->gravity && !regi_infer_search_whole(f, 0, best)) ||
        (f->pressing && !regi_infer_search_whole(f, 1, best)))
        return 0;
    regi_infer_bind_prior(f, best);
    if (!(best->gravity > 0 || best->pressure > 0))
        return 1;
    regi_gauss_reduce(&f->gauss);
    return regi_infer_search_misfit(f, best);
}

/* ---- local scale ---- */

/* What data leave of the variance of eight control points' tractions along an axis: left[8], in squares of the scale.
 */
static void regi_infer_leave(const reg_infer *f, int first, int axis, double *left)
{
    const regi_gauss *g = &f->gauss;
    int c = f->model->prior.control_count, count = sbi_min_int(REGI_BLOCK_WIDTH, c - first);
    size_t m = (size_t)g->most;
    double *x = f->tile, sum[REGI_BLOCK_WIDTH];
    regi_block block = {NULL, NULL, 0, 1, 0, 0, 0};
    memset(x, 0, (size_t)g->count * REGI_BLOCK_WIDTH * sizeof *x);
    memset(sum, 0, sizeof sum);
    block.wide = g->wide;
    block.left = f->turned_root + first;
    block.left_stride = (size_t)c;
    block.right = g->columns + (size_t)axis * m;
    block.right_step = 3 * m;
    block.right_stride = 1;
    block.depth = first + count;
    regi_block_add(&block, count, g->count, 1, x, REGI_BLOCK_WIDTH);
    regi_gauss_whiten_many(g, x);
    for (int i = 0; i < g->count; i++)
        for (int j = 0; j < REGI_BLOCK_WIDTH; j++)
            sum[j] += x[(size_t)i * REGI_BLOCK_WIDTH + (size_t)j] * x[(size_t)i * REGI_BLOCK_WIDTH + (size_t)j];
    for (int j = 0; j < count; j++)
        left[j] -= g->scale * g->scale * sum[j];
}

/* energy[c]: |tau|^2 to expect, of the mean and of what it leaves open. The gauss is solved. */
static void regi_infer_expect_energy(reg_infer *f)
{
    regi_gauss *g = &f->gauss;
    int c = f->model->prior.control_count;
    double square = g->scale * g->scale;
    regi_gauss_explain(g, g->multiplier, f->c, f->next);
    regi_infer_unfold(f, f->c, f->tractions);
    for (int j = 0; j < c; j++) {
        const double *root = f->root + (size_t)j * (size_t)c;
        double left = 0;
        for (int axis = 0; axis < 3; axis++) {
            for (int k = 0; k <= j; k++)
                left += root[k] * root[k];
            for (int e = 0; e < g->exact; e++) {
                const double *row = g->resultants + (size_t)e * (size_t)g->most_loads;
                double along = 0;
                for (int k = 0; k <= j; k++)
                    along += root[k] * row[3 * k + axis];
                left -= along * along;
            }
        }
        f->energy[j] = left;
    }
    for (int j = 0; j < c; j += REGI_BLOCK_WIDTH)
        for (int axis = 0; axis < 3; axis++)
            regi_infer_leave(f, j, axis, f->energy + j);
    for (int j = 0; j < c; j++)
        f->energy[j] =
            (double)sb_v3_dot(f->tractions[j], f->tractions[j]) + square * (f->energy[j] > 0 ? f->energy[j] : 0);
}

/* Loads of some places, while the evidence for them rises. */
static int regi_infer_localise(reg_infer *f)
{
    size_t bytes = (size_t)f->model->prior.control_count * sizeof(double);
    for (int pass = 0; pass < REGI_INFER_LOCAL; pass++) {
        regi_infer_choice before = f->choice, trial = before;
        if (!regi_gauss_solve(&f->gauss))
            return 0;
        regi_infer_expect_energy(f);
        memcpy(f->trial_local, f->local, bytes);
        f->rooted = 0;
        regi_prior_localise(&f->model->prior, REGI_INFER_LENGTH, f->energy, f->local);
        trial.is_local = 1;
        if (!regi_infer_set_prior(f, &trial))
            return 0;
        regi_gauss_reduce(&f->gauss);
        if (!regi_infer_weigh_misfit(f, &trial))
            return 0;
        if (f->temper * (trial.evidence - before.evidence) > (before.is_local ? 0.5 : regi_infer_earned)) {
            f->choice = trial;
            f->gauss.scale = trial.scale;
            continue;
        }
        memcpy(f->local, f->trial_local, bytes);
        f->rooted = 0;
        return regi_infer_set_prior(f, &before);
    }
    return 1;
}

/* ---- the choice ---- */

/* Share of the evidence that counts: neighbouring patches whose residuals are alike are not two data. */
static double regi_infer_find_temper(const reg_infer *f)
{
    const regi_gauss *g = &f->gauss;
    double products = 0, squares = 0, way = 0, length;
    int count = 0;
    for (int i = 0; i < g->count && f->patch_of[i] >= 0; i++, count++) {
        sb_real nearest = SB_REAL_MAX;
        int other = i;
        for (int j = 0; j < g->count && f->patch_of[j] >= 0; j++) {
            sb_vec3 d = sb_v3_sub(f->look.points[f->look.patch_start[f->patch_of[i]]].at,
                                  f->look.points[f->look.patch_start[f->patch_of[j]]].at);
            sb_real square = sb_v3_dot(d, d);
            if (j != i && square < nearest) {
                nearest = square;
                other = j;
            }
        }
        way += other == i ? 0 : (double)sb_sqrt(nearest);
        squares += g->variance[i] * g->variance[i] * g->multiplier[i] * g->multiplier[i];
        products += g->variance[i] * g->multiplier[i] * g->variance[other] * g->multiplier[other];
    }
    if (!(products > 0) || !(squares > 0) || products >= squares || count < 2)
        return 1;
    way /= count;
    length = -way / sbi_dense_log(products / squares);
    return way * way < 3.141592653589793 * length * length ? way * way / (3.141592653589793 * length * length) : 1;
}

/* alike: how many patches are off alike, as those are that one facet, rim or smoothed stretch of noise is under, times
 * the share of their variance that the loads of now leave over, at least 1; left: the same without that bound. Less is
 * left where loads fit what is no motion, more where the motion is longer than one round goes: neither tells of the
 * data, so it has bounds. Taken for as many data errors are loads beyond doubt, which bend the organ as a whole: 1 mm
 * of noise without any motion moved a liver that is seen from above by 2.1 mm on the mean, from a start that was 0.8 mm
 * off. 0: the gauss cannot be solved. */
static int regi_infer_count_alike(reg_infer *f)
{
    const double least = 0.2, most = 0.6;
    const regi_gauss *g = &f->gauss;
    double reach = REGI_INFER_ALIKE * f->model->spacing, gap = (double)f->spacing, sum = 0;
    int count = 0;
    if (!regi_gauss_solve(&f->gauss))
        return 0;
    for (; count < g->count && f->patch_of[count] >= 0; count++)
        sum += g->variance[count] * g->multiplier[count] * g->multiplier[count];
    f->left = sum < least * count ? least : sum > most * count ? most : sum / count;
    f->left *= gap > 0 ? 3.141592653589793 * reach * reach / (gap * gap) : 1;
    f->alike = f->left > 1 ? f->left : 1;
    return 1;
}

/* Misfit and scale again, now that it is known how many patches count as one. */
static int regi_infer_choose_again(reg_infer *f)
{
    regi_gauss_reduce(&f->gauss);
    if (!regi_infer_search_misfit(f, &f->choice))
        return 0;
    regi_infer_set_misfit(f, f->choice.misfit);
    f->gauss.scale = f->choice.scale;
    return regi_gauss_solve(&f->gauss);
}

REGI_API int regi_infer_choose(reg_infer *f)
{
    if (!regi_infer_search(f, &f->choice))
        return 0;
    regi_infer_set_misfit(f, f->choice.misfit);
    f->gauss.scale = f->choice.scale;
    if (!regi_infer_localise(f) || !regi_infer_count_alike(f) || (f->alike > 1 && !regi_infer_choose_again(f)) ||
        !regi_gauss_spectrum(&f->gauss))
        return 0;
    f->temper = regi_infer_find_temper(f);
    f->quality.pressure_margin = (sb_real)(f->temper * f->choice.earned);
    f->quality.prior_margin = (sb_real)(f->temper * (f->choice.evidence - regi_gauss_evidence(&f->gauss, 0)));
    return 1;
}

/* ==== src/register/infer_respond.c ==== */
/* infer_respond: what loads and pose do to the data where the organ is now. */

#include <string.h>

/* Deviation of the offset of all points, as share of the organ's size: so small that an organ that has lost volume is
 * rather pressed than seen through a scan that is off everywhere. */
#define REGI_INFER_OFFSET 3e-4

/* ---- responses ---- */

/* Of a load along the axes, to[3][most]: what it does to a datum or resultant. */
static void regi_infer_put(const reg_infer *f, double *to, int at, sb_vec3 v)
{
    size_t m = (size_t)f->gauss.most;
    to += at;
    to[0] = (double)v.x;
    to[m] = (double)v.y;
    to[2 * m] = (double)v.z;
}

/* What unit tractions and weights do along a row, for a resultant. */
static void regi_infer_store(reg_infer *f, int at, const sb_vec3 *row)
{
    int c = f->model->prior.control_count;
    sb_vec3 weight;
    regi_prior_collect(&f->model->prior, row, f->tractions, &weight);
    for (int j = 0; j <= c; j++)
        regi_infer_put(f, f->raw + 3 * (size_t)j * (size_t)f->gauss.most, at, j < c ? f->tractions[j] : weight);
}

/* Adds a datum's force at a node to the lefts, and what the modes, as forces, and the residual do to it. */
static void regi_infer_add_force(reg_infer *f, int datum, int node, sb_vec3 force)
{
    size_t m = (size_t)f->gauss.most, n = (size_t)f->node_count;
    sbi_between_add(f->between, datum, node, regi_response_to_factor(&f->response, force));
    for (size_t k = 0; k < REGI_RESPONSE_MODES; k++)
        f->drift[k * m + (size_t)datum] += (double)sb_v3_dot(force, f->response.drift[k * n + (size_t)node]);
    f->gauss.gap[datum] += (double)sb_v3_dot(force, f->response.recoil[node]);
}

/* Moves what the row has at the nodes of a mapping's point to a left. What is held takes no forces. */
static void regi_infer_move_point(reg_infer *f, int datum, const sb_mapping *mapping, int point)
{
    const unsigned char *held = sb_body_supports(f->model->body);
    for (int k = mapping->row_start[point]; k < mapping->row_start[point + 1]; k++) {
        int node = mapping->nodes[k];
        sb_vec3 force = sbi_body_pick_axes(held[node], sb_v3(0, 0, 0), f->row[node]);
        f->row[node] = sb_v3(0, 0, 0);
        if (force.x != 0 || force.y != 0 || force.z != 0)
            regi_infer_add_force(f, datum, node, force);
    }
}

/* Moves a datum's row to the lefts; row[nodes] is 0 again. */
static void regi_infer_move_row(reg_infer *f, int datum)
{
    int patch = f->patch_of[datum];
    if (patch < 0) {
        for (int k = 0; k < 2; k++)
            regi_infer_move_point(f, datum, &f->marks.rows.mapping, f->marks.lines[-1 - patch].points[k]);
        return;
    }
    for (int i = f->look.patch_start[patch]; i < f->look.patch_start[patch + 1]; i++)
        for (int k = 0; k < 3 && f->look.points[i].triangle >= 0; k++)
            regi_infer_move_point(f, datum, &f->model->rows.mapping,
                                  f->model->skin.elements[3 * (size_t)f->look.points[i].triangle + (size_t)k]);
}

/* The lefts: the data's rows. Gaps that loads and pose have to close in all: those seen, and those that would open if
 * the present loads and pose went; what the pose does to them. */
static void regi_infer_add_data(reg_infer *f)
{
    regi_gauss *g = &f->gauss;
    memset(f->drift, 0, REGI_RESPONSE_MODES * (size_t)g->most * sizeof *f->drift);
    memset(f->row, 0, (size_t)f->node_count * sizeof *f->row);
    for (int s = 0; s < g->count; s++) {
        double pose[REGI_INFER_POSE];
        regi_infer_row(f, s, f->row, g->gap + s, pose);
        for (int k = 0; k < REGI_INFER_POSE; k++) {
            g->pose[(size_t)k * (size_t)g->most + (size_t)s] = pose[k] * f->pose_sd[k];
            g->gap[s] += pose[k] * f->pose[k];
        }
        g->pose[(size_t)REGI_INFER_POSE * (size_t)g->most + (size_t)s] =
            f->patch_of[s] < 0 ? 0 : REGI_INFER_OFFSET * (double)f->model->size;
        regi_infer_move_row(f, s);
    }
}

/* Of nothing-held organs: takes the motion as a whole out of the responses of the data to all loads, by forces on the
 * modes. */
static void regi_infer_stop_drift(reg_infer *f)
{
    size_t m = (size_t)f->gauss.most, n = (size_t)f->node_count;
    for (int s = 0; s < f->gauss.count; s++) {
        double forces[REGI_RESPONSE_MODES];
        for (int k = 0; k < REGI_RESPONSE_MODES; k++)
            forces[k] = f->drift[(size_t)k * m + (size_t)s];
        regi_gauss_substitute(f->response.drift_system, REGI_RESPONSE_MODES, REGI_RESPONSE_MODES, forces);
        for (int k = 0; k < REGI_RESPONSE_MODES; k++)
            f->drift[(size_t)k * m + (size_t)s] = forces[k];
    }
    for (int k = 0; k < REGI_RESPONSE_MODES; k++) {
        sb_vec3 weight;
        regi_prior_collect(&f->model->prior, f->response.drift + (size_t)k * n, f->tractions, &weight);
        for (int j = 0; j <= f->model->prior.control_count; j++) {
            sb_vec3 along = j < f->model->prior.control_count ? f->tractions[j] : weight;
            const sb_real of[3] = {along.x, along.y, along.z};
            for (size_t axis = 0; axis < 3; axis++) {
                double *to = f->raw + (3 * (size_t)j + axis) * m;
                for (int s = 0; s < f->gauss.count; s++)
                    to[s] -= (double)of[axis] * f->drift[(size_t)k * m + (size_t)s];
            }
        }
    }
}

/* Responses of all data. */
static void regi_infer_measure_data(reg_infer *f)
{
    regi_gauss *g = &f->gauss;
    size_t m = (size_t)g->most;
    const regi_prior *p = &f->model->prior;
    const sbi_between_rights tractions = {p->start, p->controls, p->shares}; /* unit ones of the control points */
    sbi_between_clear(f->between);
    regi_infer_add_data(f);
    (void)sbi_between_run(f->between, &tractions); /* the factor is there */
    for (int j = 0; j < p->control_count; j++)
        for (int s = 0; s < g->count; s++)
            regi_infer_put(f, f->raw + 3 * (size_t)j * m, s,
                           regi_response_from_factor(&f->response, sbi_between_get(f->between, s, j)));
    for (size_t axis = 0; axis < REGI_INFER_WEIGHT; axis++) /* the first modes are the weight */
        memcpy(f->raw + (3 * (size_t)p->control_count + axis) * m, f->drift + axis * m,
               (size_t)g->count * sizeof *f->raw);
    if (!f->model->held)
        regi_infer_stop_drift(f);
}

/* Forces and torques about the centre, over the size, of unit loads where the organ is now. */
static void regi_infer_sum_up(reg_infer *f)
{
    const sb_vec3 *x = sb_body_positions(f->model->body);
    for (int e = 0; e < f->gauss.exact; e++) {
        sb_vec3 axis = sb_v3(e % 3 == 0, e % 3 == 1, e % 3 == 2);
        for (int i = 0; i < f->node_count; i++)
            f->row[i] =
                e < 3 ? axis : sb_v3_scale(1 / f->model->size, sb_v3_cross(axis, sb_v3_sub(x[i], f->response.centre)));
        regi_infer_store(f, f->gauss.count + e, f->row);
    }
}

/* areas[nodes]: those of the boundary's facets at each node, twice and more than once (m^2), outward, where the organ
 * is at x. */
static void regi_infer_sum_areas(const reg_infer *f, const sb_vec3 *x, sb_vec3 *areas)
{
    const sb_mesh *surface = &f->model->boundary.surface;
    const int *node = f->model->boundary.nodes;
    int width = sb_mesh_element_width(surface);
    int is_quad = sb_element_straight(surface->element_type) == SB_QUAD4;
    memset(areas, 0, (size_t)f->node_count * sizeof *areas);
    for (int e = 0; e < surface->element_count; e++) {
        const int *facet = surface->elements + (size_t)e * (size_t)width;
        sb_vec3 first = sb_v3_sub(x[node[facet[is_quad ? 2 : 1]]], x[node[facet[0]]]); /* a diagonal, or a side */
        sb_vec3 second = sb_v3_sub(x[node[facet[is_quad ? 3 : 2]]], x[node[facet[is_quad ? 1 : 0]]]);
        for (int a = 0; a < width; a++)
            areas[node[facet[a]]] = sb_v3_add(areas[node[facet[a]]], sb_v3_cross(first, second));
    }
}

/* tractions[nodes], per area at rest, of the unit pressure on the boundary where the organ is now. */
static void regi_infer_find_push(const reg_infer *f, sb_vec3 *tractions)
{
    sb_vec3 *rest = tractions + f->node_count;
    regi_infer_sum_areas(f, sb_body_positions(f->model->body), tractions);
    regi_infer_sum_areas(f, f->model->mesh.nodes, rest);
    for (int i = 0; i < f->node_count; i++) {
        sb_real area = sb_v3_norm(rest[i]);
        tractions[i] = sb_v3_scale(area > 0 ? -f->def->pressed[i] / area : 0, tractions[i]);
    }
}

/* The unit pressure where the organ is now as tractions of the control points, and what data and resultants do under
 * it, which is then known without another solve. */
static void regi_infer_press(reg_infer *f)
{
    const regi_prior *p = &f->model->prior;
    size_t m = (size_t)f->gauss.most;
    int rows = f->gauss.count + f->gauss.exact;
    double *to = f->raw + (size_t)(f->loads - 1) * m;
    sb_vec3 whole;
    regi_infer_find_push(f, f->row);
    regi_prior_collect(p, f->row, f->pressing, &whole);
    memset(to, 0, (size_t)rows * sizeof *to);
    for (int j = 0; j < p->control_count; j++) {
        const double *from = f->raw + 3 * (size_t)j * m;
        f->pressing[j] = sb_v3_scale(p->areas[j] > 0 ? (sb_real)(1 / p->areas[j]) : 0, f->pressing[j]);
        for (int s = 0; s < rows; s++)
            to[s] += (double)f->pressing[j].x * from[s] + (double)f->pressing[j].y * from[m + (size_t)s] +
                     (double)f->pressing[j].z * from[2 * m + (size_t)s];
    }
}

REGI_API void regi_infer_respond(reg_infer *f)
{
    regi_infer_measure_data(f);
    regi_infer_sum_up(f);
    if (f->pressing)
        regi_infer_press(f);
}

/* ==== src/register/infer_round.c ==== */
/* infer_round: the loads and the pose that explain the gaps, and the move there. */

#include <math.h>
#include <string.h>

/* Farthest that a round moves a node, as share of the size: the response is linear no farther. */
#define REGI_INFER_STEP ((sb_real)0.1)

/* ---- move ---- */

/* Smallest det F of the points at displacements u[nodes]. */
static sb_real regi_infer_least_volume(const reg_infer *f, const sb_vec3 *u)
{
    const sb_domain *d = &f->model->domain;
    int n = d->nodes_per_cell, q = d->points_per_cell;
    sb_real least = SB_REAL_MAX;
    for (int e = 0; e < d->cell_count; e++)
        for (int p = 0; p < q; p++) {
            const sb_real *g = d->gradients + ((size_t)e * (size_t)q + (size_t)p) * (size_t)n * 3;
            sb_mat3 deformation = sb_m3_identity();
            for (int a = 0; a < n; a++)
                deformation = sb_m3_add(deformation, sb_m3_outer(u[d->cells[(size_t)e * (size_t)n + (size_t)a]],
                                                                 sb_v3(g[3 * a], g[3 * a + 1], g[3 * a + 2])));
            least = sb_min(least, sb_m3_det(deformation));
        }
    return least;
}

/* trial = u and a share of the loads' increment and of what is new of the pose, turned as a whole. */
static void regi_infer_try(reg_infer *f, double share)
{
    const sb_vec3 *x = sb_body_positions(f->model->body);
    sb_real d[REGI_INFER_POSE];
    sb_vec3 way;
    sb_mat3 rotation;
    for (int k = 0; k < REGI_INFER_POSE; k++)
        d[k] = (sb_real)(share * (f->next[k] - f->pose[k]));
    way = sb_v3_add(f->response.centre, sb_v3(d[0], d[1], d[2]));
    rotation = sb_quat_to_mat3(sb_quat_from_rotation_vector(sb_v3(d[3], d[4], d[5])));
    for (int i = 0; i < f->node_count; i++) {
        sb_vec3 moved = sb_v3_sub(sb_v3_madd(x[i], (sb_real)share, f->increment[i]), f->response.centre);
        f->trial[i] = sb_v3_sub(sb_v3_add(sb_m3_apply(rotation, moved), way), f->model->mesh.nodes[i]);
    }
}

/* Least det F that a move may leave. */
static sb_real regi_infer_least_allowed(const reg_infer *f)
{
    sb_real now = regi_infer_least_volume(f, sb_body_displacements(f->model->body));
    return sb_min((sb_real)0.02, (sb_real)0.5 * now);
}

/* Moves there, or as far as no element comes near to turning inside out. f->before: where the organ was. */
static sb_result regi_infer_move(reg_infer *f, sb_error *error)
{
    double share = 1;
    const sb_vec3 *u = sb_body_displacements(f->model->body);
    sb_real least = regi_infer_least_allowed(f), volume = 0;
    int tries = 0;
    memcpy(f->before, sb_body_positions(f->model->body), (size_t)f->node_count * sizeof *f->before);
    do {
        sb_real way = 0;
        regi_infer_try(f, share);
        for (int i = 0; i < f->node_count; i++)
            way = sb_max(way, sb_v3_norm(sb_v3_sub(f->trial[i], u[i])));
        volume = way <= REGI_INFER_STEP * f->model->size ? regi_infer_least_volume(f, f->trial) : -1;
        if (volume >= least)
            break;
        share *= 0.5;
    } while (++tries < 40);
    if (!(volume >= least))
        return sbi_fail(error, SB_ERROR_DIVERGED, "the organ cannot be moved without turning an element inside out");
    f->quality.change = 0;
    for (int i = 0; i < f->node_count; i++)
        f->quality.change = sb_max(f->quality.change, sb_v3_norm(sb_v3_sub(f->trial[i], u[i])));
    for (int k = 0; k < REGI_INFER_POSE; k++)
        f->pose[k] += share * (f->next[k] - f->pose[k]);
    return sb_body_set_displacements(f->model->body, f->trial);
}

/* ---- the posterior ---- */

/* The posterior's mean: forces, and where they take the organ from its present shape. */
static sb_result regi_infer_solve(reg_infer *f, int round, sb_error *error)
{
    int good = round == 0 ? regi_infer_choose(f) : regi_infer_set_prior(f, &f->choice) && regi_gauss_solve(&f->gauss);
    if (!good)
        return sbi_fail(error, SB_ERROR_NOT_CONVERGED, "loads and pose cannot be told from what is seen");
    regi_gauss_explain(&f->gauss, f->gauss.multiplier, f->c, f->next);
    for (int k = 0; k < REGI_INFER_POSE; k++)
        f->next[k] *= f->pose_sd[k];
    f->quality.pressure = (sb_real)regi_infer_pressure(f, f->c);
    regi_infer_load(f, f->c, f->forces);
    for (int i = 0; i < f->node_count; i++)
        f->increment[i] = sb_v3_sub(f->forces[i], f->response.residual[i]);
    regi_response_solve(&f->response, f->increment, 1);
    return SB_OK;
}

/* ---- exact landmarks ---- */

/* Gaps of what is to be met exactly where the organ is now; of other data none. Returns the largest (m). */
static double regi_infer_find_misses(reg_infer *f)
{
    const regi_gauss *g = &f->gauss;
    double most = 0;
    memset(f->row, 0, (size_t)f->node_count * sizeof *f->row);
    for (int i = 0; i < g->count; i++) {
        double pose[REGI_INFER_POSE];
        f->datum[i] = 0;
        if (g->variance[i] > 0)
            continue;
        regi_infer_row(f, i, f->row, f->datum + i, pose);
        most = fabs(f->datum[i]) > most ? fabs(f->datum[i]) : most;
    }
    return most;
}

/* Loads and a motion of the whole that close the gaps in `datum` and no other, about where the organ was before the
 * last round: trial. */
static void regi_infer_try_to_meet(reg_infer *f)
{
    const sb_vec3 *u = sb_body_displacements(f->model->body);
    double pose[REGI_GAUSS_POSES];
    sb_real d[REGI_INFER_POSE];
    regi_gauss_apply_inverse(&f->gauss, f->datum);
    regi_gauss_explain(&f->gauss, f->datum, f->draw, pose);
    for (int k = 0; k < REGI_INFER_POSE; k++)
        d[k] = (sb_real)(pose[k] * f->pose_sd[k]);
    regi_infer_load(f, f->draw, f->increment);
    regi_response_solve(&f->response, f->increment, 1);
    for (int i = 0; i < f->node_count; i++) {
        sb_vec3 arm = sb_v3_sub(f->before[i], f->response.centre);
        sb_vec3 whole = sb_v3_add(sb_v3(d[0], d[1], d[2]), sb_v3_cross(sb_v3(d[3], d[4], d[5]), arm));
        f->trial[i] = sb_v3_add(u[i], sb_v3_add(f->increment[i], whole));
    }
}

/* The last round's finite turn and what it left of its way leave exact landmarks by a thousandth of the size: what is
 * linear about it closes that, once for the gap and once more for the rounding of a large one. Where elements would
 * turn inside out it stays. */
REGI_API sb_result regi_infer_meet(reg_infer *f)
{
    enum { TIMES = 3 };
    sb_result result = SB_OK;
    sb_real least = regi_infer_least_allowed(f);
    for (int k = 0; result == SB_OK && k < TIMES && regi_infer_find_misses(f) > 0; k++) {
        regi_infer_try_to_meet(f);
        if (!(regi_infer_least_volume(f, f->trial) >= least))
            break;
        result = sb_body_set_displacements(f->model->body, f->trial);
    }
    return result;
}

/* ---- a round ---- */

REGI_API sb_result regi_infer_round(reg_infer *f, int round, sb_error *error)
{
    double begun = regi_infer_now(f), responded;
    sb_result result;
    if (regi_infer_look(f, round) == 0)
        return sbi_fail(error, SB_ERROR_NOT_CONVERGED, "no point of the target is near a place of the organ");
    result = round == 0 ? regi_response_factor_turned(&f->response, f->def->start.rotation, error)
                        : regi_response_factor(&f->response, error);
    if (result != SB_OK)
        return result;
    regi_infer_respond(f);
    responded = regi_infer_now(f);
    f->quality.seconds_response += responded - begun;
    result = regi_infer_solve(f, round, error);
    f->quality.seconds_choice += regi_infer_now(f) - responded;
    if (result == SB_OK)
        result = regi_infer_move(f, error);
    f->quality.rounds += result == SB_OK;
    return result;
}

/* ==== src/register/infer_draws.c ==== */
/* infer_draws: how sure the answer is: draws of its error, and the report. */

#include <math.h>
#include <string.h>


/* What the predicted deviations are multiplied by, for full views and for parts. With them regions of 95 % hold the
 * truth of 97 % (whole) and 99 % (views) of the nodes of twelve organs like those of the test infer/organs, and errors
 * are 0.95 of those to expect in the geometric mean of 96 cases of insilico (tests/bench/registration.md). Parts
 * had 1.7 while errors that patches have alike counted as independent. */
#define REGI_INFER_ALPHA_FULL 1.3
#define REGI_INFER_ALPHA_VIEW 1.4

/* Views of less of the surface than this are small. */
#define REGI_INFER_SMALL 0.15
/* See regi_infer_sure. With less, whole organs are farther off than their start; with more, good answers lose. */
#define REGI_INFER_DOUBT 0.75
/* See regi_infer_widen. */
#define REGI_INFER_LEAST_MOTION 0.005

/* An error to expect above so many sizes is a view that shows too little. */
#define REGI_INFER_OPEN 0.03

/* What is not known of the material: log of the stiffness of a region (sd), and Poisson's ratio. */
#define REGI_INFER_STIFFNESS_SD 0.5
#define REGI_INFER_POISSON_SD 0.02

/* ---- the material ---- */

/* F of a point of a cell at u[nodes]. */
static sb_mat3 regi_infer_deformation(const sb_domain *d, const sb_vec3 *u, int cell, int point)
{
    const int *nodes = d->cells + (size_t)cell * (size_t)d->nodes_per_cell;
    const sb_real *g =
        d->gradients + ((size_t)cell * (size_t)d->points_per_cell + (size_t)point) * (size_t)d->nodes_per_cell * 3;
    sb_mat3 f = sb_m3_identity();
    for (int a = 0; a < d->nodes_per_cell; a++)
        f = sb_m3_add(f, sb_m3_outer(u[nodes[a]], sb_v3(g[3 * a], g[3 * a + 1], g[3 * a + 2])));
    return f;
}

/* Adds factor times a cell's internal forces for a Poisson's ratio to forces[nodes per cell]. */
static void regi_infer_add_cell(const reg_infer *f, int cell, sb_real poisson, sb_real factor, sb_vec3 *forces)
{
    const sb_domain *d = &f->model->domain;
    sb_material material = sb_material_neo_hookean(REGI_MODEL_YOUNG, poisson, 1000);
    for (int p = 0; p < d->points_per_cell; p++) {
        size_t at = (size_t)cell * (size_t)d->points_per_cell + (size_t)p;
        const sb_real *g = d->gradients + at * (size_t)d->nodes_per_cell * 3;
        sb_mat3 deformation = regi_infer_deformation(d, f->shape, cell, p), stress;
        if (!sb_material_stress(&material, &deformation, NULL, &stress))
            continue;
        for (int a = 0; a < d->nodes_per_cell; a++)
            forces[a] = sb_v3_madd(forces[a], factor * d->weights[at],
                                   sb_m3_apply(stress, sb_v3(g[3 * a], g[3 * a + 1], g[3 * a + 2])));
    }
}

/* Forces of all cells at the shape found, and what Poisson's ratio changes of them. */
static void regi_infer_split_forces(reg_infer *f)
{
    const sb_domain *d = &f->model->domain;
    size_t n = (size_t)d->nodes_per_cell;
    sb_real nu = f->model->poisson, other = sb_min(nu + (sb_real)REGI_INFER_POISSON_SD, (sb_real)0.499);
    sb_real step = (sb_real)REGI_INFER_POISSON_SD / sb_max(other - nu, SB_EPSILON);
    memset(f->cell_force, 0, (size_t)d->cell_count * n * sizeof *f->cell_force);
    memset(f->poisson_force, 0, (size_t)f->node_count * sizeof *f->poisson_force);
    for (int e = 0; e < d->cell_count; e++) {
        sb_vec3 change[SB_MAX_ELEMENT_NODES];
        sb_vec3 *own = f->cell_force + (size_t)e * n;
        memset(change, 0, sizeof change);
        regi_infer_add_cell(f, e, nu, 1, own);
        regi_infer_add_cell(f, e, other, step, change);
        for (size_t a = 0; a < n; a++) {
            sb_vec3 *to = f->poisson_force + d->cells[(size_t)e * n + a];
            *to = sb_v3_add(*to, sb_v3_madd(change[a], -step, own[a]));
        }
    }
}

static sb_vec3 regi_infer_cell_middle(const reg_infer *f, int cell)
{
    const sb_domain *d = &f->model->domain;
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int a = 0; a < d->nodes_per_cell; a++)
        sum = sb_v3_add(sum, f->model->mesh.nodes[d->cells[(size_t)cell * (size_t)d->nodes_per_cell + (size_t)a]]);
    return sb_v3_scale(1 / (sb_real)d->nodes_per_cell, sum);
}

/* Shares of smooth regions in each cell. */
static sb_result regi_infer_find_regions(reg_infer *f, int *regions, sb_error *error)
{
    int cells = f->model->domain.cell_count, chosen[REGI_INFER_REGIONS];
    sb_vec3 *middles = (sb_vec3 *)sbi_alloc(&f->allocator, (size_t)cells, sizeof(sb_vec3));
    sb_real *scratch = (sb_real *)sbi_alloc(&f->allocator, (size_t)cells, sizeof(sb_real));
    sb_real reach;
    if (middles && scratch) {
        for (int e = 0; e < cells; e++)
            middles[e] = regi_infer_cell_middle(f, e);
        *regions = reg_cloud_spread(middles, cells, sbi_min_int(cells, REGI_INFER_REGIONS), chosen, scratch);
        /* of half the volume of a cube around the organ */
        reach = f->model->size * sb_cbrt((sb_real)0.1 / (sb_real)*regions);
        for (int e = 0; e < cells; e++) {
            sb_real *row = f->region + (size_t)e * REGI_INFER_REGIONS, sum = 0;
            for (int k = 0; k < *regions; k++) {
                sb_real z = sb_v3_norm(sb_v3_sub(middles[e], middles[chosen[k]])) / reach;
                row[k] = sb_exp((sb_real)-0.5 * z * z) + SB_EPSILON;
                sum += row[k];
            }
            for (int k = 0; k < *regions; k++)
                row[k] /= sum;
        }
    }
    sbi_free(&f->allocator, scratch);
    if (middles == NULL || scratch == NULL) {
        sbi_free(&f->allocator, middles);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the regions of %d cells", cells);
    }
    sbi_free(&f->allocator, middles);
    return SB_OK;
}

/* forces[nodes] of a draw of what is not known of the material. */
static void regi_infer_draw_material(const reg_infer *f, int regions, regi_chance *chance, sb_vec3 *forces)
{
    const sb_domain *d = &f->model->domain;
    size_t n = (size_t)d->nodes_per_cell;
    double theta[REGI_INFER_REGIONS], poisson = regi_chance_normal(chance);
    for (int k = 0; k < regions; k++)
        theta[k] = REGI_INFER_STIFFNESS_SD * regi_chance_normal(chance);
    for (int i = 0; i < f->node_count; i++)
        forces[i] = sb_v3_scale((sb_real)poisson, f->poisson_force[i]);
    for (int e = 0; e < d->cell_count; e++) {
        const sb_real *share = f->region + (size_t)e * REGI_INFER_REGIONS;
        double log_stiffness = 0;
        for (int k = 0; k < regions; k++)
            log_stiffness += theta[k] * (double)share[k];
        for (size_t a = 0; a < n; a++) {
            sb_vec3 *to = forces + d->cells[(size_t)e * n + a];
            *to = sb_v3_madd(*to, (sb_real)log_stiffness, f->cell_force[(size_t)e * n + a]);
        }
    }
}

/* ---- draws ---- */

/* Standard normal deviates of a draw's loads, pose and noise. */
static double *regi_infer_chances(const reg_infer *f, int draw)
{
    return f->chances + (size_t)draw * (size_t)(f->loads + REGI_GAUSS_POSES + f->gauss.most);
}

/* What the material does in all draws, as forces into row, and the chances of the rest. They come in turns of four
 * draws, in which results are as they always were. */
static void regi_infer_draw_chances(reg_infer *f, int regions)
{
    enum { TURN = 4 };
    const regi_gauss *g = &f->gauss;
    regi_chance chance = {(uint64_t)0x9e3779b97f4a7c15u, 0, 0};
    for (int first = 0; first < REG_INFER_DRAWS; first += TURN) {
        for (int k = first; k < first + TURN; k++)
            regi_infer_draw_material(f, regions, &chance, f->row + (size_t)k * (size_t)f->node_count);
        for (int k = first; k < first + TURN; k++) {
            double *z = regi_infer_chances(f, k);
            for (int i = 0; i < g->loads + g->poses + g->count; i++)
                z[i] = regi_chance_normal(&chance);
        }
    }
}

/* Turns three numbers along the model's axes as the start turns them, so that draws are those of any frame. */
static void regi_infer_turn(const reg_infer *f, double v[3])
{
    sb_vec3 turned = sb_m3_apply(f->def->start.rotation, sb_v3((sb_real)v[0], (sb_real)v[1], (sb_real)v[2]));
    v[0] = (double)turned.x;
    v[1] = (double)turned.y;
    v[2] = (double)turned.z;
}

/* One draw of the error: its forces into `forces`, its pose into pose[7] (m, rad). errors holds what the material does.
 */
static void regi_infer_condition_draw(reg_infer *f, const double *z, const sb_vec3 *errors, sb_vec3 *forces,
                                      double pose[REGI_GAUSS_POSES])
{
    regi_gauss *g = &f->gauss;
    for (int b = 0; b < g->loads; b++)
        f->draw[b] = g->scale * *z++;
    for (int b = 0; b + 3 <= g->loads; b += 3)
        regi_infer_turn(f, f->draw + b);
    regi_gauss_balance(g, f->draw);
    for (int k = 0; k < g->poses; k++)
        pose[k] = *z++;
    regi_infer_turn(f, pose);
    regi_infer_turn(f, pose + 3);
    for (int i = 0; i < g->count; i++)
        f->datum[i] = sqrt(g->variance[i]) * *z++ + regi_infer_measure(f, i, errors);
    regi_gauss_condition(g, f->draw, pose, f->datum);
    for (int k = 0; k < REGI_INFER_POSE; k++)
        pose[k] *= f->pose_sd[k];
    regi_infer_load(f, f->draw, forces);
}

/* errors += what forces and pose of a draw do. */
static void regi_infer_add_draw(const reg_infer *f, const sb_vec3 *moved, const double pose[REGI_GAUSS_POSES],
                                sb_vec3 *errors)
{
    sb_vec3 way = sb_v3((sb_real)pose[0], (sb_real)pose[1], (sb_real)pose[2]);
    sb_vec3 turn = sb_v3((sb_real)pose[3], (sb_real)pose[4], (sb_real)pose[5]);
    for (int i = 0; i < f->node_count; i++) {
        sb_vec3 arm = sb_v3_sub(sb_v3_add(f->model->mesh.nodes[i], f->shape[i]), f->response.centre);
        errors[i] = sb_v3_add(errors[i], sb_v3_add(moved[i], sb_v3_add(way, sb_v3_cross(turn, arm))));
    }
}

static void regi_infer_draw_all(reg_infer *f, int regions)
{
    size_t n = (size_t)f->node_count;
    double pose[REG_INFER_DRAWS][REGI_GAUSS_POSES];
    regi_infer_draw_chances(f, regions);
    regi_response_solve(&f->response, f->row, REG_INFER_DRAWS);
    memcpy(f->errors, f->row, (size_t)REG_INFER_DRAWS * n * sizeof *f->row);
    for (int s = 0; s < REG_INFER_DRAWS; s++)
        regi_infer_condition_draw(f, regi_infer_chances(f, s), f->errors + (size_t)s * n, f->row + (size_t)s * n,
                                  pose[s]);
    regi_response_solve(&f->response, f->row, REG_INFER_DRAWS);
    memset(f->energy, 0, REGI_INFER_POSE * sizeof *f->energy);
    for (int s = 0; s < REG_INFER_DRAWS; s++) {
        regi_infer_add_draw(f, f->row + (size_t)s * n, pose[s], f->errors + (size_t)s * n);
        for (int k = 0; k < REGI_INFER_POSE; k++)
            f->energy[k] += pose[s][k] * pose[s][k] / (double)REG_INFER_DRAWS;
    }
}

/* The factor on predicted deviations. */
static double regi_infer_alpha(sb_real seen)
{
    double part = ((double)seen - 0.6) / 0.2;
    part = part < 0 ? 0 : part > 1 ? 1 : part;
    return REGI_INFER_ALPHA_VIEW + part * (REGI_INFER_ALPHA_FULL - REGI_INFER_ALPHA_VIEW);
}

/* Where loads explain hardly more than a pose does, others are as likely that the view does not show: for what is to be
 * expected they are at least such as move a datum by half a hundredth of the size. */
static int regi_infer_widen(reg_infer *f)
{
    regi_gauss *g = &f->gauss;
    double trace = 0, least;
    if ((double)f->quality.prior_margin >= 10)
        return 1;
    for (int i = 0; i < g->count; i++)
        trace += g->gram[(size_t)i * (size_t)g->most + (size_t)i] / g->count;
    least = REGI_INFER_LEAST_MOTION * (double)f->model->size / sqrt(trace > 0 ? trace : 1);
    if (!(trace > 0) || g->scale >= least)
        return 1;
    g->scale = least;
    return regi_gauss_solve(g);
}

/* The share of the way that pays: M^3 / (M^3 + (D E^2)^1.5) for one of M that is unsure by E, root mean squares over
 * the nodes. D grows with what is left over of the data's variance and with how many of them are off alike: data, model
 * and prior are wrong in ways that draws from them do not have. increment: the way. Landmarks and curves speak for the
 * elastic shape. */
static sb_real regi_infer_sure(const reg_infer *f)
{
    double way = 0, doubt = 0, alpha = regi_infer_alpha(f->quality.seen);
    if (f->marks.count > 0)
        return 1;
    for (int i = 0; i < f->node_count; i++)
        way += (double)sb_v3_dot(f->increment[i], f->increment[i]);
    for (size_t k = 0; k < (size_t)REG_INFER_DRAWS * (size_t)f->node_count; k++)
        doubt += (double)sb_v3_dot(f->errors[k], f->errors[k]) / (alpha * alpha * (double)REG_INFER_DRAWS);
    doubt *= REGI_INFER_DOUBT * f->left;
    return way > 0 ? (sb_real)(way * sqrt(way) / (way * sqrt(way) + doubt * sqrt(doubt))) : 1;
}

/* How much of the way from the start to the elastic shape is believed. Small views tell hardly more than a pose: half
 * of it, or nothing where loads explain no more than a pose does. Landmarks and curves speak for the elastic shape. */
static sb_real regi_infer_belief(const reg_infer *f)
{
    if (f->marks.count > 0 || f->quality.seen >= (sb_real)REGI_INFER_SMALL)
        return 1;
    return f->quality.prior_margin < 3 ? 0 : (sb_real)0.5;
}

/* The answer is between the start and the elastic shape; what is not believed of the way is in doubt, either way in
 * turn. */
static void regi_infer_hedge(reg_infer *f)
{
    size_t n = (size_t)f->node_count;
    sb_real belief = regi_infer_belief(f);
    f->quality.belief = belief;
    for (int i = 0; i < f->node_count; i++) {
        sb_vec3 x = f->model->mesh.nodes[i], start = sb_v3_sub(reg_rigid_apply(&f->def->start, x), x);
        f->increment[i] = sb_v3_sub(f->shape[i], start);
    }
    f->quality.sure = regi_infer_sure(f);
    belief *= f->quality.sure;
    for (size_t i = 0; i < n && belief < 1; i++)
        f->shape[i] = sb_v3_madd(f->shape[i], belief - 1, f->increment[i]);
    for (size_t k = 0; k < (size_t)REG_INFER_DRAWS * n && belief < 1; k++)
        f->errors[k] = sb_v3_madd(f->errors[k], k / n % 2 ? 1 - belief : belief - 1, f->increment[k % n]);
}

static sb_result regi_infer_draw_errors(reg_infer *f, sb_error *error)
{
    sb_real alpha = (sb_real)regi_infer_alpha(f->quality.seen);
    int regions = 0;
    sb_result result = regi_infer_find_regions(f, &regions, error);
    if (result != SB_OK)
        return result;
    if (!regi_infer_widen(f))
        return sbi_fail(error, SB_ERROR_NOT_CONVERGED, "what is to be expected of the errors cannot be told");
    regi_infer_split_forces(f);
    regi_infer_draw_all(f, regions);
    for (size_t k = 0; k < (size_t)REG_INFER_DRAWS * (size_t)f->node_count; k++)
        f->errors[k] = sb_v3_scale(alpha, f->errors[k]);
    for (int k = 0; k < REGI_INFER_POSE; k++)
        f->quality.pose_sd[k / 3] = sb_max(f->quality.pose_sd[k / 3], alpha * sb_sqrt((sb_real)f->energy[k]));
    return SB_OK;
}

/* ---- the report ---- */

/* Share of the skin near places of believed points. */
static sb_result regi_infer_find_seen(reg_infer *f, sb_error *error)
{
    const reg_model *m = f->model;
    sb_vec3 *places = (sb_vec3 *)sbi_alloc(&f->allocator, (size_t)f->look.point_count, sizeof *places);
    reg_kdtree *tree = NULL;
    sb_real reach = f->spacing;
    double seen = 0;
    int count = 0;
    sb_result result = SB_OK;
    if (!places)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the places of %d points", f->look.point_count);
    for (int i = 0; i < f->look.point_count; i++)
        if (f->look.points[i].trust > (sb_real)0.25 * f->look.points[i].weight)
            places[count++] = f->look.points[i].place;
    if (count > 0)
        result = reg_kdtree_create(places, count, &f->allocator, &tree, error);
    for (int i = 0; result == SB_OK && i < m->skin.node_count && count > 0; i++)
        seen += reg_kdtree_nearest(tree, f->skin[i], reach, NULL) >= 0 ? (double)m->vertex_area[i] : 0;
    f->quality.seen = (sb_real)(seen / m->area);
    reg_kdtree_destroy(tree);
    sbi_free(&f->allocator, places);
    return result;
}

static void regi_infer_measure_fit(reg_infer *f)
{
    regi_look_measure(&f->look, &f->quality.used, &f->quality.residual, &f->quality.residual_p95);
    f->quality.noise = f->look.noise;
    f->quality.misfit = (sb_real)f->choice.misfit;
}

static void regi_infer_measure_shape(reg_infer *f)
{
    const sb_domain *d = &f->model->domain;
    double before = 0, after = 0;
    for (int e = 0; e < d->cell_count; e++)
        for (int p = 0; p < d->points_per_cell; p++) {
            sb_mat3 deformation = regi_infer_deformation(d, f->shape, e, p), vectors;
            double w = (double)d->weights[(size_t)e * (size_t)d->points_per_cell + (size_t)p];
            sb_vec3 squares;
            sb_m3_eigen(sb_m3_tmul(deformation, deformation), &squares, &vectors);
            f->quality.largest_strain = sb_max(f->quality.largest_strain, sb_max(sb_sqrt(sb_max(squares.x, 0)) - 1,
                                                                                 1 - sb_sqrt(sb_max(squares.z, 0))));
            before += w;
            after += w * (double)sb_m3_det(deformation);
        }
    f->quality.volume_ratio = (sb_real)(before > 0 ? after / before : 1);
}

static void regi_infer_summarise(reg_infer *f)
{
    reg_quality *q = &f->quality;
    double sum = 0;
    for (int i = 0; i < f->node_count; i++) {
        double square = 0;
        for (int k = 0; k < REG_INFER_DRAWS; k++) {
            sb_vec3 e = f->errors[(size_t)k * (size_t)f->node_count + (size_t)i];
            square += (double)sb_v3_dot(e, e) / (double)REG_INFER_DRAWS;
        }
        f->expected[i] = (sb_real)sqrt(square);
        sum += sqrt(square) / f->node_count;
        q->expected_worst = sb_max(q->expected_worst, f->expected[i]);
    }
    q->expected = (sb_real)sum;
    q->prior = f->quality.prior_margin < 3       ? REG_PRIOR_RIGID
               : f->quality.pressure_margin >= 3 ? REG_PRIOR_PRESSURE
               : f->choice.gravity > 0           ? REG_PRIOR_GRAVITY
               : f->choice.is_local              ? REG_PRIOR_LOCAL
                                                 : REG_PRIOR_SMOOTH;
}

static void regi_infer_warn(reg_infer *f)
{
    reg_quality *q = &f->quality;
    sb_real size = f->model->size;
    if (q->seen < (sb_real)REGI_INFER_SMALL || q->expected > (sb_real)REGI_INFER_OPEN * size)
        q->warnings |= REG_WARN_VIEW_SMALL;
    if (q->used < (sb_real)0.7)
        q->warnings |= REG_WARN_MANY_OUTLIERS;
    if (q->pose_sd[0] > (sb_real)0.02 * size || q->pose_sd[1] > (sb_real)0.087)
        q->warnings |= REG_WARN_LOW_CONTRAST;
    if (q->largest_strain > (sb_real)0.3)
        q->warnings |= REG_WARN_STRAIN;
    if (sb_abs(q->volume_ratio - 1) > (sb_real)0.1)
        q->warnings |= REG_WARN_VOLUME;
    if (q->change > q->expected)
        q->warnings |= REG_WARN_NOT_AT_REST;
}

REGI_API sb_result regi_infer_tell(reg_infer *f, sb_error *error)
{
    double begun = regi_infer_now(f);
    sb_result result;
    memcpy(f->shape, sb_body_displacements(f->model->body), (size_t)f->node_count * sizeof *f->shape);
    result = regi_infer_find_seen(f, error); /* by the last look, which the gauss is about */
    if (result == SB_OK)
        result = regi_infer_draw_errors(f, error);
    if (result != SB_OK)
        return result;
    regi_infer_hedge(f);
    if (f->quality.belief * f->quality.sure < 1)
        result = sb_body_set_displacements(f->model->body, f->shape);
    (void)regi_infer_look(f, f->quality.rounds);
    regi_infer_measure_fit(f);
    regi_infer_measure_shape(f);
    regi_infer_summarise(f);
    regi_infer_warn(f);
    f->quality.seconds_draws = regi_infer_now(f) - begun;
    return SB_OK;
}

/* ==== src/register/infer_points.c ==== */
/* infer_points: what an inference says of points of the organ, and which of them is worth touching. */
#include <math.h>
#include <string.h>


/* Points of the organ at rest by its nodes. */
static sb_result regi_infer_hold_points(const reg_infer *f, const sb_vec3 *points, int count, sb_embedding_rows *rows,
                                        sb_error *error)
{
    sb_embedding_def embed = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_result result;
    memset(rows, 0, sizeof *rows);
    embed.mesh = &f->model->mesh;
    embed.points = points;
    embed.point_count = count;
    embed.kind = SB_EMBED_PLAIN;
    embed.max_distance = (sb_real)0.25 * f->model->size;
    embed.allocator = f->allocator;
    embed.jobs = f->model->jobs;
    result = sb_embedding_create(&embed, &embedding, error);
    if (result == SB_OK)
        result = sb_embedding_mapping(embedding, &f->allocator, rows, error);
    sb_embedding_destroy(embedding);
    return result;
}

/* Motion of a row's point by u[nodes]. */
static sb_vec3 regi_infer_point_motion(const sb_mapping *mapping, int point, const sb_vec3 *u)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int k = mapping->row_start[point]; k < mapping->row_start[point + 1]; k++)
        sum = sb_v3_madd(sum, mapping->weights[k], u[mapping->nodes[k]]);
    return sum;
}

static sb_vec3 regi_infer_point_error(const reg_infer *f, const sb_mapping *mapping, int point, int draw)
{
    return regi_infer_point_motion(mapping, point, f->errors + (size_t)draw * (size_t)f->node_count);
}

/* ---- where points are ---- */

/* From the draws. The inverse of a covariance of n draws of three is too large by (n - 1)/(n - 5) on the mean: that
 * factor makes regions of confidence right. */
static sb_mat3 regi_infer_point_covariance(const reg_infer *f, const sb_mapping *mapping, int point)
{
    sb_mat3 sum = sb_m3_zero();
    for (int k = 0; k < REG_INFER_DRAWS; k++) {
        sb_vec3 e = regi_infer_point_error(f, mapping, point, k);
        sum = sb_m3_add(sum, sb_m3_outer(e, e));
    }
    return sb_m3_scale(1 / (sb_real)(REG_INFER_DRAWS - 4), sum);
}

REG_API sb_result reg_infer_covariance(const reg_infer *infer, const sb_vec3 *points, int count, sb_vec3 *moved,
                                       sb_mat3 *covariances, sb_error *error)
{
    sb_embedding_rows rows;
    sb_result result;
    if (!infer || !points || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "covariances need an inference, and %d points", count);
    result = regi_infer_hold_points(infer, points, count, &rows, error);
    for (int i = 0; result == SB_OK && i < count; i++) {
        if (moved)
            moved[i] = sb_v3_add(points[i], regi_infer_point_motion(&rows.mapping, i, infer->shape));
        if (covariances)
            covariances[i] = regi_infer_point_covariance(infer, &rows.mapping, i);
    }
    sb_embedding_rows_free(&rows);
    return result;
}

/* ---- the landmark worth having ---- */

/* Mean over the nodes of the error to expect once a point is known whose draws are errors[DRAWS], to sd along each
 * axis: regression of the nodes' draws on the point's, ridge sd^2. Three that are fitted to n draws take a share of
 * 3 / n of what they tell nothing of: hence n / (n - 3), by which no node gets worse than it was. */
static double regi_infer_expect_after(const reg_infer *f, const sb_vec3 errors[REG_INFER_DRAWS], double sd)
{
    const double draws = REG_INFER_DRAWS;
    sb_mat3 own = sb_m3_zero(), inverse;
    sb_real ridge;
    double sum = 0;
    for (int k = 0; k < REG_INFER_DRAWS; k++)
        own = sb_m3_add(own, sb_m3_outer(errors[k], errors[k]));
    own = sb_m3_scale((sb_real)(1 / draws), own);
    ridge = (sb_real)(sd * sd) + SB_EPSILON * (sb_m3_trace(own) + SB_EPSILON * f->model->size * f->model->size);
    inverse = sb_m3_inverse(sb_m3_add(own, sb_m3_scale(ridge, sb_m3_identity()))); /* of an exact one, too */
    for (int i = 0; i < f->node_count; i++) {
        sb_mat3 cross = sb_m3_zero();
        double before = (double)f->expected[i] * (double)f->expected[i], after;
        for (int k = 0; k < REG_INFER_DRAWS; k++)
            cross = sb_m3_add(cross, sb_m3_outer(f->errors[(size_t)k * (size_t)f->node_count + (size_t)i], errors[k]));
        cross = sb_m3_scale((sb_real)(1 / draws), cross);
        after = before - (double)sb_m3_trace(sb_m3_mul(sb_m3_mul(cross, inverse), sb_m3_transpose(cross)));
        after *= draws / (draws - 3);
        after = after < 0 ? 0 : after < before ? after : before;
        sum += sqrt(after) / f->node_count;
    }
    return sum;
}

REG_API sb_result reg_infer_best_landmark(const reg_infer *infer, const sb_vec3 *points, int count, sb_real sd,
                                          int *best, sb_real *expected, sb_error *error)
{
    sb_embedding_rows rows;
    double least = 0;
    int first = -1;
    sb_real far;
    sb_result result;
    if (!infer || !points || !best || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the best landmark is one of some points of an inference: %d points",
                        count);
    if (!sb_is_finite(sd) || sd < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a landmark's deviation must be finite and not negative, is %g",
                        (double)sd);
    far = (sb_real)1e6 * infer->model->size; /* tells nothing, and has a square */
    result = regi_infer_hold_points(infer, points, count, &rows, error);
    for (int i = 0; result == SB_OK && i < count; i++) {
        sb_vec3 errors[REG_INFER_DRAWS];
        double after;
        for (int k = 0; k < REG_INFER_DRAWS; k++)
            errors[k] = regi_infer_point_error(infer, &rows.mapping, i, k);
        after = regi_infer_expect_after(infer, errors, (double)sb_min(sd, far));
        if (first < 0 || after < least) {
            first = i;
            least = after;
        }
    }
    sb_embedding_rows_free(&rows);
    if (result != SB_OK)
        return result;
    *best = first;
    if (expected)
        *expected = (sb_real)least;
    return SB_OK;
}

/* ==== src/register/infer.c ==== */
/* infer: see infer.h. */

#include <string.h>


#define REGI_INFER_COOKIE 0x696e6672u

REG_API reg_infer_def reg_default_infer_def(void)
{
    reg_infer_def def;
    memset(&def, 0, sizeof def);
    def.start = reg_rigid_identity();
    def.start_turn = (sb_real)0.2;
    def.gravity = 1;
    def.samples = 300;
    def.rounds = 5;
    def.max_seconds = 1e9;
    def.cookie = REGI_INFER_COOKIE;
    return def;
}

/* ---- checks ---- */

REGI_API sb_result regi_infer_check_points(const reg_points *t, sb_error *error)
{
    sb_result result;
    if ((t->points != NULL) == (t->surface != NULL))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a target needs either points or a surface");
    if (t->has_camera != 0 && t->has_camera != 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "has_camera is %d, not 0 or 1", t->has_camera);
    if (t->has_camera && !sb_v3_is_finite(t->camera))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the camera's place is not finite");
    if (t->surface)
        return SB_OK;
    result = regi_cloud_check(t->points, t->normals, t->count, error);
    for (int i = 0; result == SB_OK && i < t->count; i++)
        if ((t->sd && !(t->sd[i] > 0 && sb_is_finite(t->sd[i]))) ||
            (t->weights && !(t->weights[i] >= 0 && sb_is_finite(t->weights[i]))))
            result = sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "sd or weight of point %d is out of range", i);
    return result;
}

REGI_API int regi_infer_is_motion(const reg_rigid *motion)
{
    sb_mat3 square = sb_m3_sub(sb_m3_tmul(motion->rotation, motion->rotation), sb_m3_identity());
    return sb_v3_is_finite(motion->translation) && sb_m3_ddot(square, square) < (sb_real)1e-6 &&
           sb_m3_det(motion->rotation) > 0;
}

/* Those of a def, that count. */
static regi_marks_def regi_infer_marks_of(const reg_infer_def *def)
{
    regi_marks_def marks;
    marks.landmarks = def->landmarks;
    marks.landmark_count = def->landmark_count;
    marks.curves = def->curves;
    marks.curve_count = def->curve_count;
    marks.all = 0;
    return marks;
}

static sb_result regi_infer_check(const reg_infer_def *def, sb_error *error)
{
    regi_marks_def marks;
    sb_result result;
    if (!def || def->cookie != REGI_INFER_COOKIE || !def->model)
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "an inference needs a def made by reg_default_infer_def, and a model");
    if (def->samples < 30 || def->samples > 1000 || def->rounds < 1 || def->rounds > 100)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d samples, %d rounds: out of range", def->samples, def->rounds);
    if (!(def->start_sd >= 0 && def->start_sd <= 100 * def->model->size) ||
        !(def->start_turn > 0 && def->start_turn <= 10) || !(def->max_seconds > 0) ||
        (def->gravity != 0 && def->gravity != 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "start_sd %g, start_turn %g, max_seconds %g, gravity %d: out of range", (double)def->start_sd,
                        (double)def->start_turn, def->max_seconds, def->gravity);
    if (!regi_infer_is_motion(&def->start))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the start is no rigid motion");
    marks = regi_infer_marks_of(def);
    result = regi_marks_check_model(&marks, error);
    if (result == SB_OK)
        result = regi_marks_check_seen(&marks, sb_v3(0, 0, 0), SB_REAL_MAX, error);
    if (result != SB_OK)
        return result;
    for (int i = 0; def->pressed && i < def->model->mesh.node_count; i++)
        if (!sb_is_finite(def->pressed[i]) || !(def->pressed[i] >= 0 && def->pressed[i] <= 1))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "node %d is pressed by %g of a pressure: not 0 to 1", i,
                                 (double)def->pressed[i]);
    return regi_infer_check_points(&def->target, error);
}

/* ---- the target ---- */

/* The nodes of a surface, by area (of the mean, so that weights are about 1). */
static void regi_infer_take_surface(reg_infer *f, const sb_mesh *triangles)
{
    sb_real mean = 0;
    for (int i = 0; i < triangles->node_count; i++)
        regi_look_take(f->look.points + i, triangles->nodes[i], sb_v3(0, 0, 0), 0, 0);
    for (int t = 0; t < triangles->element_count; t++) {
        const int *c = triangles->elements + 3 * (size_t)t;
        sb_vec3 a = sb_v3_sub(triangles->nodes[c[1]], triangles->nodes[c[0]]);
        sb_vec3 area = sb_v3_cross(a, sb_v3_sub(triangles->nodes[c[2]], triangles->nodes[c[0]]));
        for (int k = 0; k < 3; k++) {
            f->look.points[c[k]].normal = sb_v3_add(f->look.points[c[k]].normal, area);
            f->look.points[c[k]].weight += sb_v3_norm(area);
        }
        mean += 3 * sb_v3_norm(area) / (sb_real)triangles->node_count;
    }
    for (int i = 0; i < triangles->node_count; i++) {
        f->look.points[i].normal = regi_cloud_unit(f->look.points[i].normal);
        f->look.points[i].weight = mean > 0 ? f->look.points[i].weight / mean : 0;
    }
}

static void regi_infer_take_cloud(reg_infer *f)
{
    const reg_points *t = &f->def->target;
    for (int i = 0; i < t->count; i++)
        regi_look_take(f->look.points + i, t->points[i], t->normals ? t->normals[i] : sb_v3(0, 0, 0),
                       t->weights ? t->weights[i] : 1, t->sd ? t->sd[i] : 0);
}

/* ---- life ---- */

REGI_API int regi_infer_most_data(const reg_infer *f) { return f->look.patch_count + regi_marks_most_lines(&f->marks); }

static void regi_infer_layout(reg_infer *f, sbi_arena *arena)
{
    size_t n = (size_t)f->node_count, c = (size_t)f->model->prior.control_count, points = (size_t)f->look.point_count;
    size_t patches = (size_t)f->look.patch_count, loads = (size_t)f->loads;
    size_t most = (size_t)regi_infer_most_data(f) + REGI_GAUSS_EXACT, cells = (size_t)f->model->domain.cell_count;
    size_t width = (size_t)f->model->domain.nodes_per_cell, real = sizeof(double), vec = sizeof(sb_vec3);
    f->look.points = (regi_look_point *)sbi_arena_take(arena, points, sizeof(regi_look_point));
    f->look.patch_start = (int *)sbi_arena_take(arena, patches + 1, sizeof(int));
    f->patch_of = (int *)sbi_arena_take(arena, most, sizeof(int));
    f->look.sort = (sb_real *)sbi_arena_take(arena, points + patches, sizeof(sb_real));
    f->averaged = (double *)sbi_arena_take(arena, most, real);
    regi_marks_layout(&f->marks, arena);
    f->raw = (double *)sbi_arena_take(arena, loads, most * real);
    f->root = (double *)sbi_arena_take(arena, c, c * real);
    f->turned_root = (double *)sbi_arena_take(arena, c, c * real);
    f->tile = (double *)sbi_arena_take(arena, most > c ? most : c, REGI_BLOCK_WIDTH * real);
    f->extended = (double *)sbi_arena_take(arena, most, most * real);
    f->local = (double *)sbi_arena_take(arena, c, real);
    f->trial_local = (double *)sbi_arena_take(arena, c, real);
    f->energy = (double *)sbi_arena_take(arena, c + REGI_INFER_POSE, real);
    f->c = (double *)sbi_arena_take(arena, loads, real);
    f->draw = (double *)sbi_arena_take(arena, loads, real);
    f->datum = (double *)sbi_arena_take(arena, most, real);
    f->chances = (double *)sbi_arena_take(arena, loads + REGI_GAUSS_POSES + most, REG_INFER_DRAWS * real);
    f->tractions = (sb_vec3 *)sbi_arena_take(arena, c, vec);
    f->pressing = f->def->pressed ? (sb_vec3 *)sbi_arena_take(arena, c, vec) : NULL;
    f->drift = (double *)sbi_arena_take(arena, REGI_RESPONSE_MODES, most * real);
    f->row = (sb_vec3 *)sbi_arena_take(arena, n, REG_INFER_DRAWS * vec);
    f->skin = (sb_vec3 *)sbi_arena_take(arena, (size_t)f->model->skin.node_count, vec);
    regi_response_layout(&f->response, f->node_count, arena);
    f->forces = (sb_vec3 *)sbi_arena_take(arena, n, vec);
    f->increment = (sb_vec3 *)sbi_arena_take(arena, n, vec);
    f->trial = (sb_vec3 *)sbi_arena_take(arena, n, vec);
    f->before = (sb_vec3 *)sbi_arena_take(arena, n, vec);
    f->shape = (sb_vec3 *)sbi_arena_take(arena, n, vec);
    f->errors = (sb_vec3 *)sbi_arena_take(arena, n, REG_INFER_DRAWS * vec);
    f->expected = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    f->cell_force = (sb_vec3 *)sbi_arena_take(arena, cells, width * vec);
    f->poisson_force = (sb_vec3 *)sbi_arena_take(arena, n, vec);
    f->region = (sb_real *)sbi_arena_take(arena, cells, REGI_INFER_REGIONS * sizeof(sb_real));
}

static sb_result regi_infer_allocate(reg_infer *f, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    int most = regi_infer_most_data(f) + REGI_GAUSS_EXACT;
    sb_result result;
    regi_infer_layout(f, &arena);
    f->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&f->allocator, 1, arena.used);
    if (!f->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for an inference from %d points", f->look.point_count);
    arena.base = (unsigned char *)f->memory;
    arena.used = 0;
    regi_infer_layout(f, &arena);
    result = regi_gauss_create(most, f->loads, &f->allocator, &f->gauss, error);
    f->response.direct = f->model->direct;
    return result;
}

/* Nodes that the rows of a mapping have at most. */
static size_t regi_infer_widest(const sb_mapping *mapping, int rows)
{
    int most = 0;
    for (int i = 0; i < rows; i++)
        most = sbi_max_int(most, mapping->row_start[i + 1] - mapping->row_start[i]);
    return (size_t)most;
}

/* Room for what the inverse goes between: the nodes that patches and lines depend on. */
static sb_result regi_infer_make_between(reg_infer *f, sb_error *error)
{
    const reg_model *m = f->model;
    size_t n = (size_t)f->node_count, lines = (size_t)regi_marks_most_lines(&f->marks),
           dense = (size_t)f->look.patch_count * n;
    size_t points = 3 * (size_t)f->look.point_count * regi_infer_widest(&m->rows.mapping, m->skin.node_count);
    size_t entries = points < dense ? points : dense;
    if (lines > 0)
        entries += 2 * lines * regi_infer_widest(&f->marks.rows.mapping, f->marks.count);
    return sbi_between_create(f->response.direct, regi_infer_most_data(f), m->prior.control_count, entries,
                              &f->allocator, &f->between, error);
}

/* The organ at the start, and what the pose may be about it. */
static sb_result regi_infer_begin(reg_infer *f)
{
    const reg_infer_def *def = f->def;
    const sb_mesh *mesh = &f->model->mesh;
    sb_vec3 middle = sb_v3(0, 0, 0);
    sb_real sd = def->start_sd > 0 ? def->start_sd : (sb_real)0.07 * f->model->size;
    for (int i = 0; i < f->node_count; i++) {
        f->trial[i] = sb_v3_sub(reg_rigid_apply(&def->start, mesh->nodes[i]), mesh->nodes[i]);
        middle = sb_v3_madd(middle, 1 / (sb_real)(i + 1), sb_v3_sub(mesh->nodes[i], middle));
    }
    f->response.centre = reg_rigid_apply(&def->start, middle);
    for (int k = 0; k < REGI_INFER_POSE; k++)
        f->pose_sd[k] = (double)(k < 3 ? sd : def->start_turn);
    f->temper = f->alike = 1;
    f->gauss.poses = REGI_GAUSS_POSES;
    f->gauss.exact = f->model->held ? 0 : REGI_GAUSS_EXACT;
    sb_body_reset(f->model->body);
    return sb_body_set_displacements(f->model->body, f->trial);
}

/* 1 when there is no time for a round that takes as long as those before. */
static int regi_infer_is_late(const reg_infer *f)
{
    double spent = regi_infer_now(f) - f->begun, round = f->quality.rounds ? spent / f->quality.rounds : 0;
    return f->def->clock && f->quality.rounds > 0 && spent + round >= f->def->max_seconds;
}

static sb_result regi_infer_iterate(reg_infer *f, sb_error *error)
{
    sb_real rest = (sb_real)1e-3 * f->model->size;
    sb_result result = SB_OK;
    f->quality.stop = REG_INFER_ROUNDS;
    for (int round = 0; result == SB_OK && round < f->def->rounds; round++) {
        if (regi_infer_is_late(f)) {
            f->quality.stop = REG_INFER_CAPPED;
            break;
        }
        result = regi_infer_round(f, round, error);
        if (f->quality.change <= rest) {
            f->quality.stop = REG_INFER_CONVERGED;
            break;
        }
    }
    return result == SB_OK ? regi_infer_meet(f) : result;
}

static sb_result regi_infer_make(reg_infer *f, const sb_mesh *triangles, sb_error *error)
{
    regi_marks_def marks;
    sb_result result;
    f->node_count = f->model->mesh.node_count;
    f->response.model = f->model;
    f->look.tree = f->model->tree;
    f->look.size = f->model->size;
    f->look.has_camera = f->def->target.has_camera;
    f->look.camera = f->def->target.camera;
    f->loads = 3 * f->model->prior.control_count + REGI_INFER_WEIGHT + (f->def->pressed != NULL);
    f->look.point_count = triangles ? triangles->node_count : f->def->target.count;
    f->look.patch_count = sbi_min_int(f->def->samples, f->look.point_count);
    marks = regi_infer_marks_of(f->def);
    regi_marks_count(&f->marks, &marks, f->model->size);
    result = regi_infer_allocate(f, error);
    if (result != SB_OK)
        return result;
    if (triangles)
        regi_infer_take_surface(f, triangles);
    else
        regi_infer_take_cloud(f);
    result = regi_infer_group(f, f->look.patch_count, error);
    if (result == SB_OK) {
        f->spacing = regi_infer_spacing(f);
        result = regi_marks_place(&f->marks, &marks, &f->model->mesh, &f->allocator, &f->model->jobs, error);
    }
    if (result == SB_OK)
        regi_marks_see(&f->marks, &marks);
    if (result == SB_OK)
        result = regi_infer_make_between(f, error);
    if (result == SB_OK)
        result = regi_infer_begin(f);
    if (result == SB_OK)
        result = regi_infer_iterate(f, error);
    return result == SB_OK ? regi_infer_tell(f, error) : result;
}

REG_API sb_result reg_infer_run(const reg_infer_def *def, reg_infer **infer, sb_error *error)
{
    sb_mesh triangles;
    reg_infer *made;
    sb_result result = regi_infer_check(def, error);
    if (result == SB_OK && !infer)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "no place for an inference");
    if (result != SB_OK)
        return result;
    memset(&triangles, 0, sizeof triangles);
    if (def->target.surface)
        result = sb_surface_triangulate(def->target.surface, &def->model->allocator, &triangles, error);
    if (result != SB_OK)
        return result;
    made = (reg_infer *)sbi_alloc_zeroed(&def->model->allocator, 1, sizeof *made);
    if (made) {
        made->allocator = def->model->allocator;
        made->def = def;
        made->model = def->model;
        made->begun = regi_infer_now(made);
        result = regi_infer_make(made, def->target.surface ? &triangles : NULL, error);
        made->quality.seconds = regi_infer_now(made) - made->begun;
        made->def = NULL;
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for an inference");
    }
    sb_mesh_free(&triangles);
    if (result == SB_OK)
        *infer = made;
    else
        reg_infer_destroy(made);
    return result;
}

REG_API void reg_infer_destroy(reg_infer *infer)
{
    sb_allocator allocator;
    if (!infer)
        return;
    allocator = infer->allocator;
    sb_embedding_rows_free(&infer->marks.rows);
    sbi_between_free(infer->between);
    regi_gauss_free(&infer->gauss);
    sbi_free(&allocator, infer->memory);
    sbi_free(&allocator, infer);
}

/* ---- the answer ---- */

REG_API sb_result reg_infer_displacements(const reg_infer *infer, sb_vec3 *displacements)
{
    if (!infer || !displacements)
        return SB_ERROR_ARGUMENT;
    memcpy(displacements, infer->shape, (size_t)infer->node_count * sizeof *displacements);
    return SB_OK;
}

REG_API sb_result reg_infer_forces(const reg_infer *infer, sb_vec3 *forces)
{
    if (!infer || !forces)
        return SB_ERROR_ARGUMENT;
    memcpy(forces, infer->forces, (size_t)infer->node_count * sizeof *forces);
    return SB_OK;
}

REG_API sb_result reg_infer_expected(const reg_infer *infer, sb_real *expected)
{
    if (!infer || !expected)
        return SB_ERROR_ARGUMENT;
    memcpy(expected, infer->expected, (size_t)infer->node_count * sizeof *expected);
    return SB_OK;
}

REG_API sb_result reg_infer_draw(const reg_infer *infer, int index, sb_vec3 *displacements)
{
    if (!infer || !displacements)
        return SB_ERROR_ARGUMENT;
    if (index < 0 || index >= REG_INFER_DRAWS)
        return SB_ERROR_INDEX;
    for (int i = 0; i < infer->node_count; i++)
        displacements[i] =
            sb_v3_add(infer->shape[i], infer->errors[(size_t)index * (size_t)infer->node_count + (size_t)i]);
    return SB_OK;
}

/* ---- the report ---- */

REG_API sb_result reg_infer_get_quality(const reg_infer *infer, reg_quality *quality)
{
    if (!infer || !quality)
        return SB_ERROR_ARGUMENT;
    *quality = infer->quality;
    return SB_OK;
}

REG_API const char *reg_prior_string(reg_prior_kind prior)
{
    switch (prior) {
    case REG_PRIOR_RIGID: return "rigid";
    case REG_PRIOR_SMOOTH: return "smooth";
    case REG_PRIOR_LOCAL: return "local";
    case REG_PRIOR_GRAVITY: return "gravity";
    case REG_PRIOR_PRESSURE: return "pressure";
    default: return "unknown prior";
    }
}

REG_API const char *reg_infer_stop_string(reg_infer_stop stop)
{
    switch (stop) {
    case REG_INFER_CONVERGED: return "converged";
    case REG_INFER_ROUNDS: return "rounds";
    case REG_INFER_CAPPED: return "time";
    default: return "unknown stop";
    }
}

/* ==== src/register/track_private.h ==== */
/* track_private: what is inside a reg_track. Floor 6, internal: track_modes.c finds the shapes, track_frame.c takes in
 * what is seen, track_state.c saves it, track.c makes it all and tells of it. */
#ifndef REG_TRACK_PRIVATE_H
#define REG_TRACK_PRIVATE_H


enum {
    REGI_TRACK_SPARE = 8,  /* loads beyond the modes, for the search of these */
    REGI_TRACK_PASSES = 2, /* of that search */
    REGI_TRACK_LOOKS = 2,  /* for places, a frame */
    REGI_TRACK_POSE = 6,   /* moves along the axes of the organ and turns about them */
    REGI_TRACK_MODES = 96, /* at most */
    REGI_TRACK_UNKNOWNS = REGI_TRACK_MODES + REGI_TRACK_POSE,
    REGI_TRACK_SURPRISES = 3, /* on end are a jump */
    REGI_TRACK_SCALES = 17,
    REGI_TRACK_WIDE = 5 /* frames that search wide after a start or a jump */
};

/* What deviations are multiplied by when they are told: as those of an inference from views. */
#define REGI_TRACK_ALPHA 1.7

/* What is known between two steps. */
typedef struct regi_track_known {
    double *mean;       /* [modes] amounts of the shapes */
    double *covariance; /* [unknowns][unknowns] of the amounts, of the pose's moves (m) and turns (rad) */
    sb_vec3 place;      /* m: of the organ's middle */
    sb_quat turned;     /* unit: of the organ */
    double time, blind; /* s */
    sb_real noise;      /* m */
    double scale;       /* of the amounts */
    double change;      /* and of what a frame changes of them */
    double evidence[REGI_TRACK_SCALES], change_evidence[REGI_TRACK_SCALES]; /* log, of scales, faded */
    sb_real usual_used, usual_innovation; /* as told of targets lately; 0: not known yet */
    int surprises;                        /* on end */
    int wide;                             /* frames that still search wide */
} regi_track_known;

struct reg_track {
    sb_allocator allocator;
    reg_track_def def; /* resolved: no zeros */
    reg_model *model;
    regi_response response;
    regi_look look;
    sb_surface *tree; /* of the skin, its own: the model's may move meanwhile */
    void *memory;
    int node_count, skin_count, unknowns; /* unknowns: modes + 6 */
    int wide;                             /* what sbi_lanes_are_wide() said */
    regi_track_known known, next;
    sb_vec3 *arms;      /* [nodes] m: from the middle, at the start, in the frame of the start */
    sb_vec3 *modes;     /* [modes][nodes] m */
    sb_vec3 *skin_arms; /* [skin nodes] */
    double *skin_modes; /* [skin nodes][3][modes] m */
    double *spread;     /* [unknowns][unknowns] mean over the nodes of D^T D, D what the unknowns do to a node */
    int *patch_of;      /* [triangles of the skin] */
    double *patch_area; /* [patches] m^2 */
    int patch_count;
    regi_marks marks;    /* landmarks and curves: what waits of them, too */
    sb_vec3 *mark_arms;  /* [marks] m, as arms */
    double *mark_modes;  /* [marks][3][modes] m */
    uint64_t marks_hash; /* of their places at rest */
    int waiting;         /* 1: incoming[] is a target */
    int incoming_count;
    regi_look_point *incoming; /* [most_points] */
    int incoming_has_camera;
    sb_vec3 incoming_camera;
    sb_vec3 *skin;                      /* [skin nodes] where they are (m) */
    double *rows;                       /* [patches + 3 + lines of marks][unknowns] over their deviations */
    double *gaps;                       /* [patches + lines of marks] likewise */
    double *forecast;                   /* [unknowns] of the state, before the target */
    double *state;                      /* [unknowns] of the look at hand: amounts, and the pose's way in this frame */
    double *information, *pull, *whole; /* [unknowns][unknowns] upper half, [unknowns] */
    double *precision, *precise, *column, *turns; /* [unknowns][unknowns] twice, [unknowns]: scratch */
    double pose_precision[REGI_TRACK_POSE * REGI_TRACK_POSE];
    double *small, *diagonal, *beside, *along, *beyond; /* [modes][modes], [modes] */
    double fresh;                                       /* share of this frame in the evidence */
    /* of the search of modes */
    double *root;                    /* [c][c] */
    double *loads;                   /* [modes + SPARE][3 c] */
    double *resultants;              /* [6][3 c] */
    double *gram, *vectors, *values; /* [modes + SPARE]^2 twice, and [3 (modes + SPARE)] */
    sb_vec3 *moved;                  /* [modes + SPARE][nodes] */
    sb_vec3 *tractions;              /* [c] */
    sb_vec3 *shape;                  /* [nodes] displacements, scratch */
};

/* ---- track_modes ---- */
/* Shapes about displacements[nodes], and everything that follows from them; known begins there. Nothing has changed
 * where it fails but scratch. */
REGI_API sb_result regi_track_linearise(reg_track *track, const sb_vec3 *displacements, const sb_real pose_sd[2],
                                        sb_error *error);

/* What follows from arms and modes: those of the skin and of marks, and spread. */
REGI_API void regi_track_derive(reg_track *track);
/* covariance (m^2) of where a node is, in the frame of the target; row: [unknowns] scratch. */
REGI_API void regi_track_covariance_of(const reg_track *track, int node, double *row, sb_mat3 *covariance);

/* ---- track_frame ---- */
/* next: what is known after dt (s) without a target. */
REGI_API void regi_track_predict(reg_track *track, double dt);
/* next: and with what waits, of targets and features. 0: no patch or line of it counts. */
REGI_API sb_result regi_track_take_in(reg_track *track, int *counted, reg_track_info *info);
/* Root mean square error to expect of the nodes (m). */
REGI_API sb_real regi_track_expected(const reg_track *track, const regi_track_known *known);
/* What is open at a start: the amounts by the prior, the pose by sd[2] (m, rad). */
REGI_API void regi_track_open(const reg_track *track, regi_track_known *known, const sb_real sd[2]);

#endif /* REG_TRACK_PRIVATE_H */

/* ==== src/register/track_modes.c ==== */
/* track_modes: the shapes that tractions of the prior give an organ, most of the motion first. */

#include <math.h>
#include <string.h>


/* ---- loads: vectors of 3 c numbers, drawn from N(0, I) by the prior ---- */

static int regi_track_load_count(const reg_track *t) { return 3 * t->model->prior.control_count; }
static int regi_track_trial_count(const reg_track *t)
{
    return sbi_min_int(t->def.modes + REGI_TRACK_SPARE, regi_track_load_count(t));
}

static double regi_track_dot(const double *a, const double *b, int n)
{
    double sum = 0;
    for (int i = 0; i < n; i++)
        sum += a[i] * b[i];
    return sum;
}

/* Takes out of a what of it is along `count` orthonormal rows (or rows of 0), twice. */
static void regi_track_clear(double *a, const double *rows, int count, int n)
{
    for (int twice = 0; twice < 2; twice++)
        for (int k = 0; k < count; k++) {
            const double *row = rows + (size_t)k * (size_t)n;
            double along = regi_track_dot(a, row, n);
            for (int i = 0; i < n; i++)
                a[i] -= along * row[i];
        }
}

/* Makes rows[count][n] orthonormal; those that are sums of the ones before become 0. */
static void regi_track_orthonormalise(double *rows, int count, int n)
{
    for (int k = 0; k < count; k++) {
        double *row = rows + (size_t)k * (size_t)n, before = sqrt(regi_track_dot(row, row, n)), after;
        regi_track_clear(row, rows, k, n);
        after = sqrt(regi_track_dot(row, row, n));
        for (int i = 0; i < n; i++)
            row[i] = after > 1e-9 * before ? row[i] / after : 0;
    }
}

/* loads: what unit loads do along row[nodes]. */
static void regi_track_collect(reg_track *t, const sb_vec3 *row, double *loads)
{
    int c = t->model->prior.control_count;
    sb_vec3 weight;
    regi_prior_collect(&t->model->prior, row, t->tractions, &weight);
    memset(loads, 0, (size_t)regi_track_load_count(t) * sizeof *loads);
    for (int j = 0; j < c; j++)
        for (int k = 0; k <= j; k++) {
            double root = t->root[(size_t)j * (size_t)c + (size_t)k];
            loads[3 * k] += root * (double)t->tractions[j].x;
            loads[3 * k + 1] += root * (double)t->tractions[j].y;
            loads[3 * k + 2] += root * (double)t->tractions[j].z;
        }
}

/* forces[nodes] of loads. */
static void regi_track_spread_loads(reg_track *t, const double *loads, sb_vec3 *forces)
{
    int c = t->model->prior.control_count;
    for (int j = 0; j < c; j++) {
        double sum[3] = {0, 0, 0};
        for (int k = 0; k <= j; k++)
            for (int axis = 0; axis < 3; axis++)
                sum[axis] += t->root[(size_t)j * (size_t)c + (size_t)k] * loads[3 * k + axis];
        t->tractions[j] = sb_v3((sb_real)sum[0], (sb_real)sum[1], (sb_real)sum[2]);
    }
    regi_prior_forces(&t->model->prior, t->tractions, sb_v3(0, 0, 0), forces);
}

/* Resultants that loads of an organ that nothing holds must not have: forces, and torques about the middle. */
static int regi_track_find_resultants(reg_track *t)
{
    const sb_vec3 *x = sb_body_positions(t->model->body);
    int count = t->model->held ? 0 : REGI_TRACK_POSE, n = regi_track_load_count(t);
    for (int e = 0; e < count; e++) {
        sb_vec3 axis = sb_v3(e % 3 == 0, e % 3 == 1, e % 3 == 2);
        for (int i = 0; i < t->node_count; i++)
            t->moved[i] =
                e < 3 ? axis : sb_v3_scale(1 / t->model->size, sb_v3_cross(axis, sb_v3_sub(x[i], t->response.centre)));
        regi_track_collect(t, t->moved, t->resultants + (size_t)e * (size_t)n);
    }
    regi_track_orthonormalise(t->resultants, count, n);
    return count;
}

/* ---- the search: subspace iteration from random loads ---- */

/* moved: what the loads do. */
static void regi_track_respond(reg_track *t)
{
    int count = regi_track_trial_count(t), n = regi_track_load_count(t);
    for (int k = 0; k < count; k++)
        regi_track_spread_loads(t, t->loads + (size_t)k * (size_t)n, t->moved + (size_t)k * (size_t)t->node_count);
    regi_response_solve(&t->response, t->moved, count);
}

/* loads: balanced, orthonormal, those that move the organ most among those that moved[] stands for. */
static void regi_track_improve(reg_track *t, int resultants)
{
    int count = regi_track_trial_count(t), n = regi_track_load_count(t);
    regi_response_solve(&t->response, t->moved, count);
    for (int k = 0; k < count; k++) {
        double *loads = t->loads + (size_t)k * (size_t)n;
        regi_track_collect(t, t->moved + (size_t)k * (size_t)t->node_count, loads);
        regi_track_clear(loads, t->resultants, resultants, n);
    }
    regi_track_orthonormalise(t->loads, count, n);
}

/* Products of the motions, mean over the nodes, and their eigenvectors. */
static int regi_track_compare(reg_track *t)
{
    int count = regi_track_trial_count(t);
    size_t n = (size_t)t->node_count;
    for (int k = 0; k < count; k++)
        for (int l = 0; l <= k; l++) {
            double sum = 0;
            for (size_t i = 0; i < n; i++)
                sum += (double)sb_v3_dot(t->moved[(size_t)k * n + i], t->moved[(size_t)l * n + i]);
            t->gram[k * count + l] = t->gram[l * count + k] = sum / (double)t->node_count;
        }
    return sbi_symmetric_eigen(t->gram, count, t->values, t->vectors, t->values + count);
}

/* 0: there are none. */
static int regi_track_search(reg_track *t)
{
    regi_chance chance = {(uint64_t)0x9e3779b97f4a7c15u, 0, 0};
    int count = regi_track_trial_count(t), n = regi_track_load_count(t), resultants;
    if (!regi_prior_root(&t->model->prior, REGI_INFER_LENGTH, NULL, t->root))
        return 0;
    resultants = regi_track_find_resultants(t);
    for (int k = 0; k < count * n; k++)
        t->loads[k] = regi_chance_normal(&chance);
    for (int k = 0; k < count; k++)
        regi_track_clear(t->loads + (size_t)k * (size_t)n, t->resultants, resultants, n);
    for (int pass = 0; pass < REGI_TRACK_PASSES; pass++) {
        regi_track_respond(t);
        regi_track_improve(t, resultants);
    }
    regi_track_respond(t);
    return regi_track_compare(t) && t->values[count - 1] > 0;
}

/* ---- what follows from the shapes ---- */

/* modes: of one unit of deviation each, and `motion` in all. */
static void regi_track_keep_modes(reg_track *t)
{
    int count = regi_track_trial_count(t);
    double sum = 0, scale;
    for (int k = 0; k < t->def.modes; k++)
        sum += t->values[count - 1 - k] > 0 ? t->values[count - 1 - k] : 0;
    scale = (double)t->def.motion / sqrt(sum);
    memset(t->modes, 0, (size_t)t->def.modes * (size_t)t->node_count * sizeof *t->modes);
    for (int k = 0; k < t->def.modes; k++) {
        const double *vector = t->vectors + (size_t)(count - 1 - k) * (size_t)count;
        sb_vec3 *mode = t->modes + (size_t)k * (size_t)t->node_count;
        for (int l = 0; l < count; l++)
            for (int i = 0; i < t->node_count; i++)
                mode[i] = sb_v3_madd(mode[i], (sb_real)(scale * vector[l]),
                                     t->moved[(size_t)l * (size_t)t->node_count + (size_t)i]);
    }
}

/* arms[count] and modes[count][3][modes] of the points of a mapping; scratch: [count]. */
static void regi_track_carry(const reg_track *t, const sb_mapping *mapping, int count, sb_vec3 *arms, double *modes,
                             sb_vec3 *scratch)
{
    size_t q = (size_t)t->def.modes;
    sb_mapping_apply(mapping, t->arms, arms);
    for (size_t k = 0; k < q; k++) {
        sb_mapping_apply(mapping, t->modes + k * (size_t)t->node_count, scratch);
        for (int i = 0; i < count; i++) {
            double *to = modes + (size_t)i * 3 * q + k;
            to[0] = (double)scratch[i].x;
            to[q] = (double)scratch[i].y;
            to[2 * q] = (double)scratch[i].z;
        }
    }
}

/* row[unknowns]: what they do to a node along an axis of the organ. */
static void regi_track_node_row(const reg_track *t, int node, int axis, double *row)
{
    sb_vec3 line = sb_v3(axis == 0, axis == 1, axis == 2), turn = sb_v3_cross(t->arms[node], line);
    for (int k = 0; k < t->def.modes; k++)
        row[k] = (double)sb_v3_dot(line, t->modes[(size_t)k * (size_t)t->node_count + (size_t)node]);
    row += t->def.modes;
    row[0] = (double)line.x, row[1] = (double)line.y, row[2] = (double)line.z;
    row[3] = (double)turn.x, row[4] = (double)turn.y, row[5] = (double)turn.z;
}

static void regi_track_find_spread(reg_track *t)
{
    size_t n = (size_t)t->unknowns;
    double share = sqrt(1.0 / t->node_count);
    memset(t->spread, 0, n * n * sizeof *t->spread);
    for (int i = 0; i < t->node_count; i++) {
        for (int axis = 0; axis < 3; axis++) {
            double *row = t->rows + (size_t)axis * n;
            regi_track_node_row(t, i, axis, row);
            for (size_t k = 0; k < n; k++)
                row[k] *= share;
        }
        regi_gauss_add_squares(t->wide, t->spread, t->unknowns, t->rows, 3, n);
    }
    for (size_t k = 0; k < n; k++)
        for (size_t l = 0; l < k; l++)
            t->spread[k * n + l] = t->spread[l * n + k];
}

REGI_API void regi_track_covariance_of(const reg_track *t, int node, double *row, sb_mat3 *covariance)
{
    size_t n = (size_t)t->unknowns;
    sb_mat3 turned = sb_quat_to_mat3(t->known.turned);
    double rows[3][REGI_TRACK_UNKNOWNS];
    for (int axis = 0; axis < 3; axis++)
        regi_track_node_row(t, node, axis, rows[axis]);
    for (int a = 0; a < 3; a++) {
        memset(row, 0, n * sizeof *row);
        for (size_t k = 0; k < n; k++)
            for (size_t l = 0; l < n; l++)
                row[l] += rows[a][k] * t->known.covariance[k * n + l];
        for (int b = 0; b < 3; b++)
            covariance->m[a][b] =
                (sb_real)(REGI_TRACK_ALPHA * REGI_TRACK_ALPHA * regi_track_dot(row, rows[b], t->unknowns));
    }
    *covariance = sb_m3_mul(turned, sb_m3_mul(*covariance, sb_m3_transpose(turned)));
}

REGI_API void regi_track_derive(reg_track *t)
{
    regi_track_carry(t, &t->model->rows.mapping, t->skin_count, t->skin_arms, t->skin_modes, t->skin);
    if (t->marks.count > 0)
        regi_track_carry(t, &t->marks.rows.mapping, t->marks.count, t->mark_arms, t->mark_modes, t->marks.places);
    regi_track_find_spread(t);
}

static void regi_track_begin(reg_track *t, const reg_rigid *pose, const sb_real pose_sd[2])
{
    const sb_vec3 *x = sb_body_positions(t->model->body);
    for (int i = 0; i < t->node_count; i++)
        t->arms[i] = sb_v3_sub(x[i], t->response.centre);
    regi_track_keep_modes(t);
    regi_track_derive(t);
    memset(t->known.mean, 0, (size_t)t->def.modes * sizeof *t->known.mean);
    t->known.place = reg_rigid_apply(pose, t->response.centre);
    t->known.turned = sb_quat_from_mat3(pose->rotation);
    t->known.blind = 0;
    t->known.surprises = 0;
    regi_track_open(t, &t->known, pose_sd);
}

/* Puts the body to displacements[nodes], but without the rigid motion in them, which is told: shapes must not depend on
 * the frame that the organ is seen in. */
static sb_result regi_track_place_body(reg_track *t, const sb_vec3 *displacements, reg_rigid *pose, sb_error *error)
{
    const sb_vec3 *rest = t->model->mesh.nodes;
    sb_vec3 middle = sb_v3(0, 0, 0);
    reg_rigid back;
    sb_result result;
    for (int i = 0; i < t->node_count; i++)
        t->shape[i] = sb_v3_add(rest[i], displacements[i]);
    result = reg_rigid_fit(rest, t->shape, NULL, t->node_count, pose, error);
    if (result != SB_OK)
        return result;
    back = reg_rigid_inverse(pose);
    for (int i = 0; i < t->node_count; i++) {
        sb_vec3 x = reg_rigid_apply(&back, t->shape[i]);
        middle = sb_v3_madd(middle, 1 / (sb_real)(i + 1), sb_v3_sub(x, middle));
        t->shape[i] = sb_v3_sub(x, rest[i]);
    }
    t->response.centre = middle;
    sb_body_reset(t->model->body);
    result = sb_body_set_displacements(t->model->body, t->shape);
    return result == SB_OK ? SB_OK : sbi_fail(error, result, "the organ cannot be placed where it is to begin");
}

REGI_API sb_result regi_track_linearise(reg_track *t, const sb_vec3 *displacements, const sb_real pose_sd[2],
                                        sb_error *error)
{
    reg_rigid pose;
    sb_result result = regi_track_place_body(t, displacements, &pose, error);
    if (result == SB_OK)
        result = regi_response_factor(&t->response, error);
    if (result != SB_OK)
        return result;
    if (!regi_track_search(t))
        return sbi_fail(error, SB_ERROR_INDEFINITE, "no load moves the organ");
    regi_track_begin(t, &pose, pose_sd);
    return SB_OK;
}

/* ==== src/register/track_frame.c ==== */
/* track_frame: what is known of an organ's pose and shape, from one frame to the next. */

#include <math.h>
#include <string.h>


/* ---- a start, and time that goes by ---- */

REGI_API void regi_track_open(const reg_track *t, regi_track_known *known, const sb_real sd[2])
{
    size_t n = (size_t)t->unknowns;
    memset(known->covariance, 0, n * n * sizeof *known->covariance);
    memset(known->evidence, 0, sizeof known->evidence);
    memset(known->change_evidence, 0, sizeof known->change_evidence);
    known->scale = 1;
    for (int k = 0; k < t->unknowns; k++) {
        int pose = k - t->def.modes;
        double deviation = pose < 0 ? known->scale : (double)sd[pose / 3];
        known->covariance[(size_t)k * n + (size_t)k] = deviation * deviation;
    }
    known->wide = REGI_TRACK_WIDE;
    known->usual_used = known->usual_innovation = 0;
    known->surprises = 0;
}

/* Copies but for the arrays, which stay. */
static void regi_track_copy_small(const regi_track_known *from, regi_track_known *to)
{
    double *mean = to->mean, *covariance = to->covariance;
    *to = *from;
    to->mean = mean;
    to->covariance = covariance;
}

REGI_API void regi_track_predict(reg_track *t, double dt)
{
    size_t n = (size_t)t->unknowns, q = (size_t)t->def.modes;
    double kept = sbi_dense_exp(-dt / (double)t->def.memory);
    regi_track_copy_small(&t->known, &t->next);
    for (size_t k = 0; k < q; k++)
        t->next.mean[k] = kept * t->known.mean[k];
    for (size_t k = 0; k < n; k++)
        for (size_t l = 0; l < n; l++)
            t->next.covariance[k * n + l] = (k < q ? kept : 1) * (l < q ? kept : 1) * t->known.covariance[k * n + l];
    for (size_t k = 0; k < n; k++) {
        double rate = (double)(k < q + 3 ? t->def.wander : t->def.turn);
        t->next.covariance[k * n + k] += k < q ? (1 - kept * kept) * t->known.scale * t->known.scale : rate * rate * dt;
    }
    t->next.time += dt;
    t->next.blind += dt;
}

REGI_API sb_real regi_track_expected(const reg_track *t, const regi_track_known *known)
{
    size_t n = (size_t)t->unknowns;
    double sum = 0;
    for (size_t k = 0; k < n * n; k++)
        sum += known->covariance[k] * t->spread[k];
    return (sb_real)REGI_TRACK_ALPHA * sb_sqrt((sb_real)(sum > 0 ? sum : 0));
}

/* ---- looking ---- */

/* The pose of the state at hand. */
static void regi_track_pose(const reg_track *t, sb_vec3 *place, sb_quat *turned)
{
    const double *way = t->state + t->def.modes;
    sb_vec3 move = sb_v3((sb_real)way[0], (sb_real)way[1], (sb_real)way[2]);
    sb_vec3 turn = sb_v3((sb_real)way[3], (sb_real)way[4], (sb_real)way[5]);
    *place = sb_v3_add(t->next.place, sb_m3_apply(sb_quat_to_mat3(t->next.turned), move));
    *turned = sb_quat_normalise(sb_quat_mul(t->next.turned, sb_quat_from_rotation_vector(turn)));
}

/* Where points of these arms and shapes are in the state at hand: moved[count]. */
static void regi_track_move(const reg_track *t, const sb_vec3 *arms, const double *modes, int count, sb_vec3 place,
                            sb_mat3 rotation, sb_vec3 *moved)
{
    size_t q = (size_t)t->def.modes;
    for (int i = 0; i < count; i++) {
        const double *mode = modes + (size_t)i * 3 * q;
        double sum[3] = {0, 0, 0};
        for (int axis = 0; axis < 3; axis++)
            for (size_t k = 0; k < q; k++)
                sum[axis] += mode[(size_t)axis * q + k] * t->state[k];
        moved[i] = sb_v3_add(arms[i], sb_v3((sb_real)sum[0], (sb_real)sum[1], (sb_real)sum[2]));
        moved[i] = sb_v3_add(place, sb_m3_apply(rotation, moved[i]));
    }
}

/* Finds the places of the points that came in, and sorts them by the patch that these are in. */
static void regi_track_sort_points(reg_track *t)
{
    int *start = t->look.patch_start;
    memset(start, 0, (size_t)(t->patch_count + 1) * sizeof *start);
    for (int i = 0; i < t->incoming_count; i++) {
        regi_look_point *p = t->incoming + i;
        regi_look_place(&t->look, p);
        p->patch = p->triangle < 0 ? 0 : t->patch_of[p->triangle];
        start[p->patch + 1]++;
    }
    for (int s = 0; s < t->patch_count; s++)
        start[s + 1] += start[s];
    for (int i = 0; i < t->incoming_count; i++)
        t->look.points[start[t->incoming[i].patch]++] = t->incoming[i];
    memmove(start + 1, start, (size_t)t->patch_count * sizeof *start);
    start[0] = 0;
    t->look.point_count = t->incoming_count;
}

/* How far off points are followed at least (m): as far as is expected, and a coarse model may be off; in the frames
 * after a start as far as loads may well have moved the organ. */
static sb_real regi_track_early_limit(const reg_track *t)
{
    sb_real size = t->model->size, wide = (sb_real)0.08 * size;
    sb_real limit = sb_max((sb_real)0.01 * size, sb_min(wide, 3 * regi_track_expected(t, &t->next)));
    for (int k = t->next.wide; k < REGI_TRACK_WIDE; k++)
        wide *= (sb_real)0.5;
    return t->next.wide > 0 ? sb_max(wide, limit) : limit;
}

static sb_result regi_track_look(reg_track *t, sb_error *error)
{
    sb_vec3 place;
    sb_quat turned;
    sb_mat3 rotation;
    sb_result result;
    regi_track_pose(t, &place, &turned);
    rotation = sb_quat_to_mat3(turned);
    regi_track_move(t, t->mark_arms, t->mark_modes, t->marks.count, place, rotation, t->marks.places);
    regi_marks_follow(&t->marks);
    regi_track_move(t, t->skin_arms, t->skin_modes, t->skin_count, place, rotation, t->skin);
    result = sb_surface_move(t->tree, t->skin, &t->model->jobs, error);
    if (result != SB_OK)
        return result;
    regi_track_sort_points(t);
    regi_look_judge(&t->look, regi_track_early_limit(t), t->next.wide > 0 ? 4 : 6);
    return SB_OK;
}

/* ---- rows ---- */

/* Adds w of what amounts of the shapes do along a line (in the frame of the organ) to a point of these. */
static void regi_track_add_modes(const reg_track *t, const double *mode, double w, sb_vec3 line, double *row)
{
    size_t q = (size_t)t->def.modes;
    double x = w * (double)line.x, y = w * (double)line.y, z = w * (double)line.z;
    for (size_t k = 0; k < q; k++)
        row[k] += x * mode[k] + y * mode[q + k] + z * mode[2 * q + k];
}

/* And what the pose does to a point with this arm from the middle. */
static void regi_track_add_pose(const reg_track *t, sb_vec3 arm, sb_vec3 line, double *row)
{
    sb_vec3 turn = sb_v3_cross(arm, line);
    row += t->def.modes;
    row[0] += (double)line.x, row[1] += (double)line.y, row[2] += (double)line.z;
    row[3] += (double)turn.x, row[4] += (double)turn.y, row[5] += (double)turn.z;
}

/* Adds what the state does to a point along its plane's normal. */
static void regi_track_add_point(const reg_track *t, const regi_look_point *p, sb_vec3 place, sb_mat3 rotation,
                                 double *row)
{
    const int *corners = t->model->skin.elements + 3 * (size_t)p->triangle;
    sb_vec3 line = sb_v3_scale(p->share, sb_m3_tapply(rotation, p->plane));
    for (int c = 0; c < 3; c++)
        regi_track_add_modes(t, t->skin_modes + (size_t)corners[c] * 3 * (size_t)t->def.modes, (double)p->corner[c],
                             line, row);
    regi_track_add_pose(t, sb_m3_tapply(rotation, sb_v3_sub(p->place, place)), line, row);
}

/* The row of a patch and its gap, over its deviation. */
static void regi_track_fill_row(reg_track *t, int patch, sb_vec3 place, sb_mat3 rotation, double *row, double *gap)
{
    double misfit = (double)t->def.misfit, scale = regi_look_share_patch(&t->look, patch);
    scale = 1 / (double)sb_sqrt((sb_real)(scale + misfit * misfit));
    memset(row, 0, (size_t)t->unknowns * sizeof *row);
    *gap = 0;
    for (int i = t->look.patch_start[patch]; i < t->look.patch_start[patch + 1]; i++) {
        const regi_look_point *p = t->look.points + i;
        if (!(p->share > 0) || p->triangle < 0)
            continue;
        *gap += scale * (double)(p->share * p->gap);
        regi_track_add_point(t, p, place, rotation, row);
    }
    for (int k = 0; k < t->unknowns; k++)
        row[k] *= scale;
}

/* Rows and gaps of the patches that count; returns how many, and what share of the surface they are. */
static int regi_track_fill_rows(reg_track *t, sb_real *seen)
{
    sb_real least = regi_look_least_trust(&t->look);
    int count = 0;
    double area = 0;
    sb_vec3 place;
    sb_quat turned;
    sb_mat3 rotation;
    regi_track_pose(t, &place, &turned);
    rotation = sb_quat_to_mat3(turned);
    for (int s = 0; s < t->patch_count; s++)
        if (regi_look_patch_trust(&t->look, s) > least) {
            regi_track_fill_row(t, s, place, rotation, t->rows + (size_t)count * (size_t)t->unknowns, t->gaps + count);
            area += t->patch_area[s];
            count++;
        }
    *seen = (sb_real)(area / t->model->area);
    return count;
}

/* ---- the filter ---- */

/* inverse[n][n] of the factor at hand. */
static void regi_track_invert(const double *factor, int n, double *column, double *inverse)
{
    for (int k = 0; k < n; k++) {
        memset(column, 0, (size_t)n * sizeof *column);
        column[k] = 1;
        regi_gauss_substitute(factor, n, (size_t)n, column);
        for (int l = 0; l <= k; l++)
            inverse[(size_t)k * (size_t)n + (size_t)l] = inverse[(size_t)l * (size_t)n + (size_t)k] = column[l];
    }
}

/* information: what rows tell of the state; pull: where they draw it from the forecast, and whole: from amounts of 0.
 */
static void regi_track_gather(reg_track *t, int count)
{
    size_t n = (size_t)t->unknowns;
    memset(t->information, 0, n * n * sizeof *t->information);
    regi_gauss_add_squares(t->wide, t->information, t->unknowns, t->rows, count, n);
    memset(t->pull, 0, n * sizeof *t->pull);
    memset(t->whole, 0, n * sizeof *t->whole);
    for (int i = 0; i < count; i++) {
        const double *row = t->rows + (size_t)i * n;
        double now = 0, before = 0;
        for (size_t k = 0; k < n; k++) {
            now += row[k] * t->state[k];
            before += row[k] * t->forecast[k];
        }
        for (size_t k = 0; k < n; k++) {
            t->pull[k] += (t->gaps[i] + now - before) * row[k];
            t->whole[k] += (t->gaps[i] + now) * row[k];
        }
    }
}

/* Squared gaps over what was expected of them before the target, mean. The state is the forecast. -1: not positive. */
static double regi_track_surprise(reg_track *t, int count)
{
    size_t n = (size_t)t->unknowns;
    double squares = 0, explained = 0;
    memcpy(t->precise, t->next.covariance, n * n * sizeof *t->precise);
    if (!regi_gauss_cholesky(t->wide, t->precise, t->unknowns, n))
        return -1;
    regi_track_invert(t->precise, t->unknowns, t->column, t->precision);
    for (size_t k = 0; k < n * n; k++)
        t->precise[k] = t->precision[k] + t->information[k];
    if (!regi_gauss_cholesky(t->wide, t->precise, t->unknowns, n))
        return -1;
    memset(t->column, 0, n * sizeof *t->column);
    for (int i = 0; i < count; i++) {
        squares += t->gaps[i] * t->gaps[i];
        for (size_t k = 0; k < n; k++)
            t->column[k] += t->gaps[i] * t->rows[(size_t)i * n + k];
    }
    memcpy(t->precision, t->column, n * sizeof *t->precision); /* is not needed any more */
    regi_gauss_substitute(t->precise, t->unknowns, n, t->column);
    for (size_t k = 0; k < n; k++)
        explained += t->column[k] * t->precision[k];
    return (squares - explained) / count;
}

/* prior[6][6]: the precision of the pose before the target. 0: it is not positive. */
static int regi_track_weigh_pose(reg_track *t)
{
    double factor[REGI_TRACK_POSE * REGI_TRACK_POSE];
    size_t n = (size_t)t->unknowns, q = (size_t)t->def.modes;
    for (size_t k = 0; k < REGI_TRACK_POSE; k++)
        for (size_t l = 0; l < REGI_TRACK_POSE; l++)
            factor[k * REGI_TRACK_POSE + l] = t->next.covariance[(q + k) * n + q + l];
    if (!regi_gauss_cholesky(0, factor, REGI_TRACK_POSE, REGI_TRACK_POSE))
        return 0;
    regi_track_invert(factor, REGI_TRACK_POSE, t->column, t->pose_precision);
    return 1;
}

/* precise: the upper half of information and the pose's prior. */
static void regi_track_add_pose_prior(reg_track *t)
{
    size_t n = (size_t)t->unknowns, q = (size_t)t->def.modes;
    memcpy(t->precise, t->information, n * n * sizeof *t->precise);
    for (size_t k = 0; k < REGI_TRACK_POSE; k++)
        for (size_t l = k; l < REGI_TRACK_POSE; l++)
            t->precise[(q + k) * n + q + l] += t->pose_precision[k * REGI_TRACK_POSE + l];
}

/* along[q]: pull without what the pose, of this factor, takes of it. */
static void regi_track_reduce_pull(const reg_track *t, const double *factor, const double *pull, double *along)
{
    size_t n = (size_t)t->unknowns, q = (size_t)t->def.modes;
    double part[REGI_TRACK_POSE];
    memcpy(part, pull + q, sizeof part);
    regi_gauss_substitute(factor, REGI_TRACK_POSE, REGI_TRACK_POSE, part);
    for (size_t a = 0; a < q; a++) {
        along[a] = pull[a];
        for (size_t k = 0; k < REGI_TRACK_POSE; k++)
            along[a] -= t->precise[a * n + q + k] * part[k];
    }
}

/* Takes the pose out of information, pull and whole: small[q][q], full, along[q] and beyond[q] are of the amounts
 * alone. */
static int regi_track_reduce(reg_track *t)
{
    size_t n = (size_t)t->unknowns, q = (size_t)t->def.modes;
    double factor[REGI_TRACK_POSE * REGI_TRACK_POSE];
    regi_track_add_pose_prior(t);
    for (size_t k = 0; k < REGI_TRACK_POSE; k++)
        for (size_t l = k; l < REGI_TRACK_POSE; l++)
            factor[k * REGI_TRACK_POSE + l] = t->precise[(q + k) * n + q + l];
    if (!regi_gauss_cholesky(0, factor, REGI_TRACK_POSE, REGI_TRACK_POSE))
        return 0;
    regi_track_reduce_pull(t, factor, t->pull, t->along);
    regi_track_reduce_pull(t, factor, t->whole, t->beyond);
    for (size_t a = 0; a < q; a++) {
        double solved[REGI_TRACK_POSE];
        memcpy(solved, t->precise + a * n + q, sizeof solved);
        regi_gauss_substitute(factor, REGI_TRACK_POSE, REGI_TRACK_POSE, solved);
        for (size_t b = a; b < q; b++) {
            double sum = t->precise[a * n + b];
            for (size_t k = 0; k < REGI_TRACK_POSE; k++)
                sum -= solved[k] * t->precise[b * n + q + k];
            t->small[a * q + b] = t->small[b * q + a] = sum;
        }
    }
    return 1;
}

/* log evidence of a scale of the amounts, by elimination of small made tridiagonal; along is turned with it. */
static double regi_track_evidence(const reg_track *t, const double *along, double scale)
{
    double square = scale * scale, pivot = 1, part = 0, sum = 0;
    for (int k = 0; k < t->def.modes; k++) {
        double beside = k > 0 ? square * t->beside[k - 1] : 0, ratio = beside / pivot;
        pivot = 1 + square * t->diagonal[k] - ratio * beside;
        pivot = pivot > 1 ? pivot : 1; /* for rounding */
        part = along[k] - ratio * part;
        sum += square * part * part / pivot - sbi_dense_log(pivot);
    }
    return 0.5 * sum;
}

/* The scale of the most evidence, faded in, of those from 1/128 to 2, a factor of sqrt2 apart. */
static double regi_track_best_scale(const reg_track *t, const double *along, double fresh, double *evidence)
{
    double scale = 0.0078125, best = scale, most = 0;
    for (int k = 0; k < REGI_TRACK_SCALES; k++) {
        evidence[k] += fresh * (regi_track_evidence(t, along, scale) - evidence[k]);
        if (k == 0 || evidence[k] > most) {
            most = evidence[k];
            best = scale;
        }
        scale *= 1.4142135623730951;
    }
    return best;
}

/* Chooses the scales: of the change since the forecast, and of the amounts. */
static int regi_track_choose(reg_track *t)
{
    if (!regi_track_reduce(t))
        return 0;
    sbi_symmetric_tridiagonalise(t->small, t->def.modes, t->diagonal, t->beside, t->column, t->turns);
    sbi_symmetric_turn(t->small, t->def.modes, t->column, t->along);
    sbi_symmetric_turn(t->small, t->def.modes, t->column, t->beyond);
    t->next.change = regi_track_best_scale(t, t->along, t->fresh, t->next.change_evidence);
    t->next.scale = regi_track_best_scale(t, t->beyond, t->fresh, t->next.evidence);
    return t->diagonal[t->def.modes - 1] < 1e300; /* not NaN */
}

/* precise: the factor of information, the pose before, and amounts of a scale. 0: not positive. */
static int regi_track_factor(reg_track *t, double scale)
{
    size_t n = (size_t)t->unknowns;
    regi_track_add_pose_prior(t);
    for (int k = 0; k < t->def.modes; k++)
        t->precise[(size_t)k * n + (size_t)k] += 1 / (scale * scale);
    return regi_gauss_cholesky(t->wide, t->precise, t->unknowns, n);
}

/* The state that information and pull, the pose before and a change of the scale suggest. */
static int regi_track_solve(reg_track *t)
{
    size_t n = (size_t)t->unknowns;
    if (!regi_track_factor(t, t->next.change))
        return 0;
    memcpy(t->state, t->pull, n * sizeof *t->state);
    regi_gauss_substitute(t->precise, t->unknowns, n, t->state);
    for (size_t k = 0; k < n; k++)
        t->state[k] += t->forecast[k];
    return t->state[0] < 1e300; /* not NaN */
}

/* next: the state at hand. What is open of it is what amounts of their scale leave open, not the change alone: what
 * the frames before were off by, this one is, too. */
static int regi_track_settle(reg_track *t)
{
    sb_vec3 place;
    sb_quat turned;
    if (!regi_track_factor(t, t->next.scale))
        return 0;
    regi_track_pose(t, &place, &turned);
    t->next.place = place;
    t->next.turned = turned;
    memcpy(t->next.mean, t->state, (size_t)t->def.modes * sizeof *t->state);
    regi_track_invert(t->precise, t->unknowns, t->column, t->next.covariance);
    if (t->look.point_count > 0)
        t->next.noise = t->look.noise;
    t->next.blind = 0;
    return 1;
}

/* ---- landmarks and curves ---- */

/* The row of a line and its gap (m). */
static void regi_track_fill_line(const reg_track *t, const regi_marks_line *line, sb_vec3 place, sb_mat3 rotation,
                                 double *row, double *gap)
{
    sb_vec3 at = sb_v3(0, 0, 0), axis = sb_m3_tapply(rotation, line->axis);
    memset(row, 0, (size_t)t->unknowns * sizeof *row);
    for (int end = 0; end < 2; end++) {
        sb_real part = end ? line->share : 1 - line->share;
        size_t mark = (size_t)line->points[end];
        at = sb_v3_madd(at, part, t->marks.places[mark]);
        regi_track_add_modes(t, t->mark_modes + mark * 3 * (size_t)t->def.modes, (double)part, axis, row);
    }
    regi_track_add_pose(t, sb_m3_tapply(rotation, sb_v3_sub(at, place)), axis, row);
    *gap = (double)sb_v3_dot(sb_v3_sub(line->seen, at), line->axis);
}

/* What the target alone says: precision becomes the covariance that it leaves, and column the state. information and
 * pull are of its patches. 0: not positive. */
static int regi_track_weigh_target(reg_track *t)
{
    size_t n = (size_t)t->unknowns;
    if (!regi_track_factor(t, t->next.scale))
        return 0;
    regi_track_invert(t->precise, t->unknowns, t->column, t->precision);
    memcpy(t->column, t->pull, n * sizeof *t->column);
    regi_gauss_substitute(t->precise, t->unknowns, n, t->column);
    for (size_t k = 0; k < n; k++)
        t->column[k] += t->forecast[k];
    return 1;
}

/* How much `count` lines (2 or 3) of one feature count, whose rows[count][unknowns], gaps (m) and variance (m^2) these
 * are: less the farther they are off what the target says, for what that leaves open. */
static double regi_track_trust_lines(const reg_track *t, const double *rows, const double *gaps, double variance,
                                     int count)
{
    const double freedom = 3, open = REGI_TRACK_ALPHA * REGI_TRACK_ALPHA / variance;
    size_t n = (size_t)t->unknowns;
    sb_mat3 expected = sb_m3_identity(), inverse;
    double off[3] = {0, 0, 0}, squares;
    sb_vec3 along;
    for (int a = 0; a < count; a++) {
        const double *row = rows + (size_t)a * n;
        off[a] = gaps[a];
        for (size_t k = 0; k < n; k++)
            off[a] += row[k] * (t->state[k] - t->column[k]);
        for (int b = 0; b <= a; b++) {
            const double *other = rows + (size_t)b * n;
            double sum = 0;
            for (size_t k = 0; k < n; k++) {
                double part = 0;
                for (size_t l = 0; l < n; l++)
                    part += t->precision[k * n + l] * other[l];
                sum += row[k] * part;
            }
            expected.m[a][b] = expected.m[b][a] = (sb_real)(open * sum + (a == b));
        }
    }
    if (sb_m3_spd_inverse(expected, &inverse) != 0)
        return 0;
    along = sb_v3((sb_real)off[0], (sb_real)off[1], (sb_real)off[2]);
    squares = (double)sb_v3_dot(along, sb_m3_apply(inverse, along)) / variance;
    return squares > count ? (freedom + count) / (freedom + squares) : 1;
}

/* Adds rows and gaps of the lines of landmarks and curves behind those of `count` patches; returns how many there are
 * then. */
static int regi_track_fill_lines(reg_track *t, int count, sb_real *trusted)
{
    size_t n = (size_t)t->unknowns;
    double least = 1e-4 * (double)t->model->size, misfit = (double)t->def.misfit, sum = 0;
    int features = 0, width;
    sb_vec3 place;
    sb_quat turned;
    sb_mat3 rotation;
    regi_track_pose(t, &place, &turned);
    rotation = sb_quat_to_mat3(turned);
    for (int first = 0; first < t->marks.line_count; first += width) {
        double *rows = t->rows + (size_t)count * n, *gaps = t->gaps + count, variance, trust, scale;
        width = first < t->marks.fixed_count ? 3 : 2;
        /* three samples of a curve are as far apart as two patches are: what the shapes miss is one for them */
        variance = t->marks.lines[first].variance + least * least + (width == 2 ? 3 : 1) * misfit * misfit;
        for (int k = 0; k < width; k++)
            regi_track_fill_line(t, t->marks.lines + first + k, place, rotation, rows + (size_t)k * n, gaps + k);
        trust = regi_track_trust_lines(t, rows, gaps, variance, width);
        scale = sqrt(trust / variance);
        for (size_t k = 0; k < (size_t)width * n; k++)
            rows[k] *= scale;
        for (int k = 0; k < width; k++)
            gaps[k] *= scale;
        sum += trust;
        features++;
        count += width;
    }
    *trusted = (sb_real)(features > 0 ? sum / features : 0);
    return count;
}

static sb_result regi_track_take_look(reg_track *t, int look, int *counted, reg_track_info *info)
{
    sb_real p95;
    sb_result result = regi_track_look(t, &info->error);
    if (result != SB_OK)
        return result;
    *counted = regi_track_fill_rows(t, &info->seen);
    regi_look_measure(&t->look, &info->used, &info->residual, &p95);
    regi_track_gather(t, *counted);
    if (t->marks.line_count > 0) {
        if (!regi_track_weigh_target(t))
            return sbi_fail(&info->error, SB_ERROR_INDEFINITE, "what is known of the organ is not positive any more");
        *counted = regi_track_fill_lines(t, *counted, &info->trusted);
        regi_track_gather(t, *counted);
    }
    if (*counted == 0)
        return SB_OK;
    if (look == 0) {
        info->innovation = (sb_real)regi_track_surprise(t, *counted);
        if (info->innovation < 0 || !regi_track_choose(t))
            return sbi_fail(&info->error, SB_ERROR_INDEFINITE, "what is known of the organ is not positive any more");
    }
    if (!regi_track_solve(t))
        return sbi_fail(&info->error, SB_ERROR_INDEFINITE, "the target cannot be taken in");
    return SB_OK;
}

REGI_API sb_result regi_track_take_in(reg_track *t, int *counted, reg_track_info *info)
{
    sb_result result = SB_OK;
    memset(t->state, 0, (size_t)t->unknowns * sizeof *t->state);
    memcpy(t->state, t->next.mean, (size_t)t->def.modes * sizeof *t->state);
    memcpy(t->forecast, t->state, (size_t)t->unknowns * sizeof *t->state);
    t->look.has_camera = t->incoming_has_camera;
    t->look.camera = t->incoming_camera;
    *counted = 0;
    if (!t->waiting)
        t->incoming_count = 0;
    if (!regi_track_weigh_pose(t))
        return sbi_fail(&info->error, SB_ERROR_INDEFINITE, "what is known of the pose is not positive any more");
    for (int look = 0; look < REGI_TRACK_LOOKS && (look == 0 || *counted > 0); look++) {
        result = regi_track_take_look(t, look, counted, info);
        if (result != SB_OK)
            return result;
    }
    if (*counted > 0 && !regi_track_settle(t))
        return sbi_fail(&info->error, SB_ERROR_INDEFINITE, "the target cannot be taken in");
    info->noise = t->next.noise;
    return result;
}

/* ==== src/register/track_state.c ==== */
/* track_state: saves what a tracker is at, and brings it back. Numbers are little-endian, 4 or 8 bytes. */
#include <string.h>


static const char regi_track_magic[9] = "REGTRACK";
enum { REGI_TRACK_VERSION = 2 };

/* One walk over what is saved: counts it, writes it, looks whether it may be read, or reads it. */
typedef struct regi_track_image {
    unsigned char *out;      /* NULL: nothing is written */
    const unsigned char *in; /* NULL: nothing is read */
    int keeps;               /* of what is read; 0: it is looked at only */
    size_t used;
    int bad; /* a number that is not finite was read */
} regi_track_image;

static uint64_t regi_track_word(regi_track_image *image, uint64_t word, int bytes)
{
    if (image->out)
        sbi_put_bytes(image->out + image->used, word, bytes);
    if (image->in)
        word = sbi_get_bytes(image->in + image->used, bytes);
    image->used += (size_t)bytes;
    return word;
}

/* Returns what is there after the walk has come by, kept or not. */
static int regi_track_int(regi_track_image *image, int *value)
{
    int found = sbi_int_of(regi_track_word(image, (uint64_t)(uint32_t)*value, 4));
    *value = image->keeps ? found : *value;
    return found;
}

static double regi_track_double(regi_track_image *image, double *value)
{
    double found;
    uint64_t word;
    memcpy(&word, value, sizeof word);
    word = regi_track_word(image, word, 8);
    memcpy(&found, &word, sizeof found);
    image->bad |= image->in && !isfinite(found);
    *value = image->keeps ? found : *value;
    return found;
}

static void regi_track_doubles(regi_track_image *image, double *values, size_t count)
{
    for (size_t i = 0; i < count; i++)
        (void)regi_track_double(image, values + i);
}

static sb_real regi_track_real(regi_track_image *image, sb_real *value)
{
    sb_real found = sbi_real_of(regi_track_word(image, sbi_real_bits(*value), (int)sizeof(sb_real)));
    image->bad |= image->in && !sb_is_finite(found);
    *value = image->keeps ? found : *value;
    return found;
}

static void regi_track_vectors(regi_track_image *image, sb_vec3 *values, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        (void)regi_track_real(image, &values[i].x);
        (void)regi_track_real(image, &values[i].y);
        (void)regi_track_real(image, &values[i].z);
    }
}

/* ---- what is saved ---- */

/* 64 bits that differ for other rest shapes and surfaces. */
static uint64_t regi_track_hash_model(const reg_model *model)
{
    uint64_t hash = (uint64_t)model->mesh.node_count;
    for (int i = 0; i < model->mesh.node_count; i++) {
        hash = sbi_hash_word(hash, sbi_real_bits(model->mesh.nodes[i].x));
        hash = sbi_hash_word(hash, sbi_real_bits(model->mesh.nodes[i].y));
        hash = sbi_hash_word(hash, sbi_real_bits(model->mesh.nodes[i].z));
    }
    for (int i = 0; i < 3 * model->skin.element_count; i++)
        hash = sbi_hash_word(hash, (uint64_t)(uint32_t)model->skin.elements[i]);
    return hash;
}

/* What two trackers must have in common. 1: the image's is this one's. */
static int regi_track_walk_make(const reg_track *t, regi_track_image *image)
{
    reg_track_def def = t->def;
    sb_real *reals[] = {&def.pose_sd, &def.pose_turn, &def.motion, &def.memory, &def.wander, &def.turn, &def.misfit};
    uint64_t hash = sbi_hash_word(regi_track_hash_model(t->model), t->marks_hash);
    int skin = t->skin_count, same = regi_track_word(image, hash, 8) == hash;
    same &= regi_track_int(image, &skin) == t->skin_count;
    same &= regi_track_int(image, &def.modes) == t->def.modes;
    same &= regi_track_int(image, &def.patches) == t->def.patches;
    same &= regi_track_double(image, &def.lost_after) == t->def.lost_after;
    for (size_t i = 0; i < sizeof reals / sizeof *reals; i++) {
        sb_real own = *reals[i];
        same &= regi_track_real(image, reals[i]) == own;
    }
    return same;
}

/* 0: a number is out of its range. */
static int regi_track_walk_known(reg_track *t, regi_track_image *image)
{
    regi_track_known *k = &t->known;
    size_t n = (size_t)t->unknowns;
    sb_quat turned;
    int surprises, wide, good;
    regi_track_doubles(image, k->mean, (size_t)t->def.modes);
    regi_track_doubles(image, k->covariance, n * n);
    regi_track_vectors(image, &k->place, 1);
    turned.x = regi_track_real(image, &k->turned.x);
    turned.y = regi_track_real(image, &k->turned.y);
    turned.z = regi_track_real(image, &k->turned.z);
    turned.w = regi_track_real(image, &k->turned.w);
    good = sb_abs(turned.x * turned.x + turned.y * turned.y + turned.z * turned.z + turned.w * turned.w - 1) <
           (sb_real)1e-3;
    good &= regi_track_double(image, &k->time) >= 0;
    good &= regi_track_double(image, &k->blind) >= 0;
    good &= regi_track_real(image, &k->noise) >= 0;
    good &= regi_track_double(image, &k->scale) >= 0;
    good &= regi_track_double(image, &k->change) >= 0;
    regi_track_doubles(image, k->evidence, REGI_TRACK_SCALES);
    regi_track_doubles(image, k->change_evidence, REGI_TRACK_SCALES);
    good &= regi_track_real(image, &k->usual_used) >= 0;
    (void)regi_track_real(image, &k->usual_innovation);
    surprises = regi_track_int(image, &k->surprises);
    wide = regi_track_int(image, &k->wide);
    return good && surprises >= 0 && surprises < REGI_TRACK_SURPRISES && wide >= 0 && wide <= REGI_TRACK_WIDE;
}

/* One point that waits. A target is fresh, so its points have no places yet. */
static int regi_track_walk_point(regi_track_image *image, regi_look_point *point)
{
    sb_real weight, sd;
    if (image->keeps)
        regi_look_take(point, sb_v3(0, 0, 0), sb_v3(0, 0, 0), 0, 0);
    regi_track_vectors(image, &point->at, 1);
    regi_track_vectors(image, &point->normal, 1);
    weight = regi_track_real(image, &point->weight);
    sd = regi_track_real(image, &point->sd);
    return weight >= 0 && sd >= 0;
}

/* Which features wait: landmarks that are seen, and samples of curves, are counted. 0: out of range. */
static int regi_track_walk_seen(reg_track *t, regi_track_image *image, int *landmarks, int *samples)
{
    int good = 1;
    *landmarks = *samples = 0;
    for (int i = 0; i < t->marks.landmark_count + t->marks.curve_count; i++) {
        int found = regi_track_int(image, t->marks.seen + i),
            most = i < t->marks.landmark_count ? 1 : REGI_MARKS_SAMPLES;
        good &= found >= 0 && found <= most;
        *(i < t->marks.landmark_count ? landmarks : samples) += good ? found : 0;
    }
    return good;
}

/* Bytes of where they are seen. */
static size_t regi_track_feature_bytes(int landmarks, int samples)
{
    const size_t place = 3 * sizeof(sb_real);
    return (size_t)landmarks * (place + 8) + (size_t)samples * (2 * place + 8);
}

/* Where they are seen. 0: out of range, or not so many bytes. */
static int regi_track_walk_features(reg_track *t, regi_track_image *image, int landmarks, int samples, size_t room)
{
    int good = 1;
    if (image->in && room - image->used < regi_track_feature_bytes(landmarks, samples))
        return 0;
    for (int i = 0; i < landmarks; i++) {
        regi_track_vectors(image, &t->marks.lines[3 * i].seen, 1);
        good &= regi_track_double(image, &t->marks.lines[3 * i].variance) >= 0;
    }
    for (int i = 0; i < samples; i++) {
        regi_track_vectors(image, &t->marks.samples[i].seen, 1);
        regi_track_vectors(image, &t->marks.samples[i].tangent, 1);
        good &= regi_track_double(image, &t->marks.samples[i].variance) >= 0;
    }
    if (good && image->keeps)
        regi_marks_index(&t->marks);
    return good;
}

/* The target that waits, if one does, of which `waiting` is known. `room`: bytes that the image has for it. 0: out of
 * range. */
static int regi_track_walk_target(reg_track *t, regi_track_image *image, int waiting, size_t room)
{
    const size_t head = 4 + 3 * sizeof(sb_real) + 4, bytes = 8 * sizeof(sb_real);
    int camera, count, good;
    if (waiting == 0)
        return 1;
    if (image->in && (waiting != 1 || room < image->used + head))
        return 0;
    camera = regi_track_int(image, &t->incoming_has_camera);
    regi_track_vectors(image, &t->incoming_camera, 1);
    count = regi_track_int(image, &t->incoming_count);
    good = (camera == 0 || camera == 1) && count >= 0 && count <= t->def.most_points &&
           (image->in == NULL || room - image->used == (size_t)count * bytes);
    for (int i = 0; good && i < count; i++)
        good &= regi_track_walk_point(image, t->incoming + i);
    return good;
}

/* All but the make; 0: out of range. */
static int regi_track_walk(reg_track *t, regi_track_image *image, size_t room)
{
    size_t nodes = (size_t)t->node_count;
    int good = regi_track_walk_known(t, image), landmarks, samples, waiting;
    regi_track_vectors(image, t->arms, nodes);
    regi_track_vectors(image, t->modes, nodes * (size_t)t->def.modes);
    good &= regi_track_walk_seen(t, image, &landmarks, &samples);
    waiting = regi_track_int(image, &t->waiting);
    return good && regi_track_walk_features(t, image, landmarks, samples, room) &&
           regi_track_walk_target(t, image, waiting, room);
}

/* ---- the calls ---- */

/* A walk that counts or writes changes nothing. */
static size_t regi_track_put(const reg_track *track, unsigned char *out)
{
    reg_track view = *track;
    regi_track_image image;
    memset(&image, 0, sizeof image);
    image.out = out;
    (void)regi_track_walk_make(&view, &image);
    (void)regi_track_walk(&view, &image, 0);
    return image.used;
}

REG_API size_t reg_track_save_size(const reg_track *track)
{
    return track ? regi_track_put(track, NULL) + SBI_IMAGE_HEAD + SBI_IMAGE_TAIL : 0;
}

REG_API sb_result reg_track_save(const reg_track *track, void *buffer, size_t size)
{
    size_t needed = reg_track_save_size(track);
    if (!track || !buffer || size < needed)
        return SB_ERROR_ARGUMENT;
    (void)regi_track_put(track, (unsigned char *)buffer + SBI_IMAGE_HEAD);
    sbi_image_seal((unsigned char *)buffer, needed, regi_track_magic, REGI_TRACK_VERSION);
    return SB_OK;
}

/* Bytes of a state where nothing waits: all that a walk reads before it can know how much does. */
static size_t regi_track_least(const reg_track *track)
{
    reg_track view = *track;
    view.waiting = 0;
    return regi_track_put(&view, NULL) - regi_track_feature_bytes(view.marks.fixed_count / 3, view.marks.sample_count);
}

static sb_result regi_track_check_content(const reg_track *track, const unsigned char *in, size_t size, sb_error *error)
{
    reg_track view = *track;
    regi_track_image image;
    int good;
    memset(&image, 0, sizeof image);
    image.in = in;
    if (size < regi_track_least(track) || !regi_track_walk_make(&view, &image))
        return sbi_fail(error, SB_ERROR_STATE, "the saved tracker is of another model or def");
    good = regi_track_walk(&view, &image, size) && image.used == size;
    if (image.bad)
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the saved tracker holds a number that is not finite");
    return good ? SB_OK : sbi_fail(error, SB_ERROR_FORMAT, "the saved tracker has a number out of its range");
}

REG_API sb_result reg_track_load(reg_track *track, const void *buffer, size_t size, sb_error *error)
{
    const unsigned char *bytes = (const unsigned char *)buffer;
    regi_track_image image;
    sb_result result;
    if (!track || !buffer)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a load needs a tracker and a state");
    result = sbi_image_check(bytes, size, regi_track_magic, REGI_TRACK_VERSION, "tracker", error);
    if (result == SB_OK) {
        size -= SBI_IMAGE_HEAD + SBI_IMAGE_TAIL;
        result = regi_track_check_content(track, bytes + SBI_IMAGE_HEAD, size, error);
    }
    if (result != SB_OK)
        return result;
    memset(&image, 0, sizeof image);
    image.in = bytes + SBI_IMAGE_HEAD;
    image.keeps = 1;
    (void)regi_track_walk_make(track, &image);
    (void)regi_track_walk(track, &image, size);
    regi_track_derive(track);
    return SB_OK;
}

/* ==== src/register/track.c ==== */
/* track: see track.h. */

#include <string.h>


#define REGI_TRACK_COOKIE 0x7472616bu
/* s: evidence of scales fades in that. */
#define REGI_TRACK_FADES 0.1

REG_API reg_track_def reg_default_track_def(void)
{
    reg_track_def def;
    memset(&def, 0, sizeof def);
    def.pose = reg_rigid_identity();
    def.modes = 48;
    def.patches = 300;
    def.most_points = 2000;
    def.memory = 1;
    def.lost_after = 0.5;
    def.cookie = REGI_TRACK_COOKIE;
    return def;
}

/* ---- checks ---- */

static int regi_track_in(sb_real value, sb_real low, sb_real high) { return value >= low && value <= high; }

static sb_result regi_track_check_numbers(const reg_track_def *def, sb_error *error)
{
    sb_real far = 100 * def->model->size;
    if (def->modes < 1 || def->modes > REGI_TRACK_MODES || def->patches < 30 || def->patches > 1000 ||
        def->most_points < 1 || def->most_points > 10000000)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d modes, %d patches, %d points at most: out of range", def->modes,
                        def->patches, def->most_points);
    if (!regi_track_in(def->pose_sd, 0, far) || !regi_track_in(def->motion, 0, far) ||
        !regi_track_in(def->wander, 0, far) || !regi_track_in(def->misfit, 0, far))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "pose_sd %g, motion %g, wander %g, misfit %g: not from 0 to 100 sizes of the organ",
                        (double)def->pose_sd, (double)def->motion, (double)def->wander, (double)def->misfit);
    if (!regi_track_in(def->pose_turn, 0, 10) || !regi_track_in(def->turn, 0, 10) ||
        !(def->memory > 0 && sb_is_finite(def->memory)) || !(def->lost_after > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "pose_turn %g, turn %g, memory %g, lost_after %g: out of range",
                        (double)def->pose_turn, (double)def->turn, (double)def->memory, def->lost_after);
    return SB_OK;
}

/* All that frames may tell of, as they are in these arrays. */
static regi_marks_def regi_track_marks_of(const reg_track_def *def, const reg_landmark *landmarks,
                                          const reg_curve *curves)
{
    regi_marks_def marks;
    marks.landmarks = landmarks;
    marks.landmark_count = def->landmark_count;
    marks.curves = curves;
    marks.curve_count = def->curve_count;
    marks.all = 1;
    return marks;
}

static sb_result regi_track_check(const reg_track_def *def, sb_error *error)
{
    regi_marks_def marks;
    sb_result result;
    if (!def || def->cookie != REGI_TRACK_COOKIE || !def->model)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a tracker needs a def made by reg_default_track_def, and a model");
    if (def->start && def->start->model != def->model)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the start is of another model");
    if (!regi_infer_is_motion(&def->pose))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the pose is no rigid motion");
    marks = regi_track_marks_of(def, def->landmarks, def->curves);
    result = regi_marks_check_model(&marks, error);
    return result == SB_OK ? regi_track_check_numbers(def, error) : result;
}

/* Fills in what the caller left open. */
static void regi_track_resolve(reg_track *t)
{
    reg_track_def *def = &t->def;
    sb_real size = t->model->size;
    const reg_quality *found = def->start ? &def->start->quality : NULL;
    def->modes = sbi_min_int(def->modes, 3 * t->model->prior.control_count);
    def->motion = def->motion > 0 ? def->motion : (sb_real)0.03 * size;
    def->wander = def->wander > 0 ? def->wander : (sb_real)0.04 * size;
    def->turn = def->turn > 0 ? def->turn : (sb_real)0.15;
    if (!(def->misfit > 0))
        def->misfit = found ? found->misfit : (sb_real)regi_infer_least_misfit(t->model);
    if (!(def->pose_sd > 0))
        def->pose_sd = found ? found->pose_sd[0] : (sb_real)0.02 * size;
    if (!(def->pose_turn > 0))
        def->pose_turn = found ? found->pose_sd[1] : (sb_real)0.05;
}

/* ---- life ---- */

static void regi_track_layout_search(reg_track *t, sbi_arena *arena)
{
    size_t c = (size_t)t->model->prior.control_count, trials = (size_t)t->def.modes + REGI_TRACK_SPARE;
    size_t real = sizeof(double), vec = sizeof(sb_vec3), nodes = (size_t)t->node_count;
    t->root = (double *)sbi_arena_take(arena, c, c * real);
    t->loads = (double *)sbi_arena_take(arena, trials, 3 * c * real);
    t->resultants = (double *)sbi_arena_take(arena, REGI_TRACK_POSE, 3 * c * real);
    t->gram = (double *)sbi_arena_take(arena, trials, trials * real);
    t->vectors = (double *)sbi_arena_take(arena, trials, trials * real);
    t->values = (double *)sbi_arena_take(arena, trials, 3 * real);
    t->moved = (sb_vec3 *)sbi_arena_take(arena, nodes, trials * vec);
    t->tractions = (sb_vec3 *)sbi_arena_take(arena, c, vec);
    t->shape = (sb_vec3 *)sbi_arena_take(arena, nodes, vec);
}

static void regi_track_layout_known(const reg_track *t, regi_track_known *known, sbi_arena *arena)
{
    size_t n = (size_t)t->unknowns;
    known->mean = (double *)sbi_arena_take(arena, n, sizeof(double));
    known->covariance = (double *)sbi_arena_take(arena, n, n * sizeof(double));
}

static void regi_track_layout(reg_track *t, sbi_arena *arena)
{
    size_t nodes = (size_t)t->node_count, skin = (size_t)t->skin_count, q = (size_t)t->def.modes;
    size_t n = (size_t)t->unknowns, points = (size_t)t->def.most_points, patches = (size_t)t->def.patches;
    size_t real = sizeof(double), vec = sizeof(sb_vec3), lines = (size_t)regi_marks_most_lines(&t->marks);
    regi_response_layout(&t->response, t->node_count, arena);
    regi_track_layout_known(t, &t->known, arena);
    regi_track_layout_known(t, &t->next, arena);
    t->arms = (sb_vec3 *)sbi_arena_take(arena, nodes, vec);
    t->modes = (sb_vec3 *)sbi_arena_take(arena, nodes, q * vec);
    t->skin_arms = (sb_vec3 *)sbi_arena_take(arena, skin, vec);
    t->skin_modes = (double *)sbi_arena_take(arena, skin, 3 * q * real);
    t->spread = (double *)sbi_arena_take(arena, n, n * real);
    t->patch_of = (int *)sbi_arena_take(arena, (size_t)t->model->skin.element_count, sizeof(int));
    t->patch_area = (double *)sbi_arena_take(arena, patches, real);
    t->incoming = (regi_look_point *)sbi_arena_take(arena, points, sizeof(regi_look_point));
    t->look.points = (regi_look_point *)sbi_arena_take(arena, points, sizeof(regi_look_point));
    t->look.patch_start = (int *)sbi_arena_take(arena, patches + 1, sizeof(int));
    t->look.sort = (sb_real *)sbi_arena_take(arena, points + patches, sizeof(sb_real));
    t->skin = (sb_vec3 *)sbi_arena_take(arena, skin, vec);
    t->rows = (double *)sbi_arena_take(arena, patches + 3 + lines, n * real);
    t->gaps = (double *)sbi_arena_take(arena, patches + lines, real);
    t->mark_arms = (sb_vec3 *)sbi_arena_take(arena, (size_t)t->marks.count, vec);
    t->mark_modes = (double *)sbi_arena_take(arena, (size_t)t->marks.count, 3 * q * real);
    regi_marks_layout(&t->marks, arena);
    t->information = (double *)sbi_arena_take(arena, n, n * real);
    t->beyond = (double *)sbi_arena_take(arena, q, real);
    t->whole = (double *)sbi_arena_take(arena, n, real);
    t->pull = (double *)sbi_arena_take(arena, n, real);
    t->forecast = (double *)sbi_arena_take(arena, n, real);
    t->small = (double *)sbi_arena_take(arena, q, q * real);
    t->diagonal = (double *)sbi_arena_take(arena, q, real);
    t->beside = (double *)sbi_arena_take(arena, q, real);
    t->along = (double *)sbi_arena_take(arena, q, real);
    t->turns = (double *)sbi_arena_take(arena, n, real);
    t->state = (double *)sbi_arena_take(arena, n, real);
    t->precision = (double *)sbi_arena_take(arena, n, n * real);
    t->precise = (double *)sbi_arena_take(arena, n, n * real);
    t->column = (double *)sbi_arena_take(arena, n, real);
    regi_track_layout_search(t, arena);
}

static sb_result regi_track_allocate(reg_track *t, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    sb_result result;
    regi_track_layout(t, &arena);
    t->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&t->allocator, 1, arena.used);
    if (!t->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a tracker of %d nodes", t->node_count);
    arena.base = (unsigned char *)t->memory;
    arena.used = 0;
    regi_track_layout(t, &arena);
    result = sb_surface_create(&t->model->skin, &t->allocator, &t->tree, error);
    return result == SB_OK ? sbi_body_make_factor(t->model->body, &t->allocator, &t->response.direct, error) : result;
}

/* Patches of the skin: triangles by the closest of vertices spread evenly. */
static sb_result regi_track_cut_skin(reg_track *t, sb_error *error)
{
    const sb_mesh *skin = &t->model->skin;
    int patches = sbi_min_int(t->def.patches, skin->node_count);
    int *chosen = (int *)sbi_alloc(&t->allocator, (size_t)patches, sizeof *chosen);
    sb_real *scratch = (sb_real *)sbi_alloc(&t->allocator, (size_t)skin->node_count, sizeof *scratch);
    if (chosen && scratch)
        t->patch_count = reg_cloud_spread(skin->nodes, skin->node_count, patches, chosen, scratch);
    sbi_free(&t->allocator, scratch);
    for (int e = 0; chosen && e < skin->element_count; e++) {
        const int *c = skin->elements + 3 * (size_t)e;
        sb_vec3 a = skin->nodes[c[0]], b = skin->nodes[c[1]], d = skin->nodes[c[2]];
        sb_vec3 middle = sb_v3_scale((sb_real)(1.0 / 3), sb_v3_add(a, sb_v3_add(b, d)));
        sb_real nearest = SB_REAL_MAX;
        for (int s = 0; s < t->patch_count; s++) {
            sb_vec3 way = sb_v3_sub(middle, skin->nodes[chosen[s]]);
            if (sb_v3_dot(way, way) < nearest) {
                nearest = sb_v3_dot(way, way);
                t->patch_of[e] = s;
            }
        }
        t->patch_area[t->patch_of[e]] += 0.5 * (double)sb_v3_norm(sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(d, a)));
    }
    t->look.patch_count = t->patch_count;
    sbi_free(&t->allocator, chosen);
    return t->patch_count > 0
               ? SB_OK
               : sbi_fail(error, SB_ERROR_MEMORY, "no memory for the patches of %d vertices", skin->node_count);
}

/* shape: where the organ is to begin, as displacements. */
static void regi_track_shape_of(reg_track *t, const reg_infer *start, const reg_rigid *pose)
{
    const sb_vec3 *rest = t->model->mesh.nodes;
    for (int i = 0; i < t->node_count; i++)
        t->shape[i] = start ? start->shape[i] : sb_v3_sub(reg_rigid_apply(pose, rest[i]), rest[i]);
}

/* Where landmarks and curves are on the model; none is seen yet. */
static sb_result regi_track_place_marks(reg_track *t, sb_error *error)
{
    const regi_marks_def marks = regi_track_marks_of(&t->def, t->def.landmarks, t->def.curves);
    regi_marks *m = &t->marks;
    sb_result result = regi_marks_place(m, &marks, &t->model->mesh, &t->allocator, &t->model->jobs, error);
    t->marks_hash = (uint64_t)m->landmark_count;
    for (int i = 0; i < m->curve_count; i++)
        t->marks_hash = sbi_hash_word(t->marks_hash, (uint64_t)(uint32_t)m->starts[i]);
    for (int i = 0; i < m->count; i++) {
        t->marks_hash = sbi_hash_word(t->marks_hash, sbi_real_bits(m->places[i].x));
        t->marks_hash = sbi_hash_word(t->marks_hash, sbi_real_bits(m->places[i].y));
        t->marks_hash = sbi_hash_word(t->marks_hash, sbi_real_bits(m->places[i].z));
    }
    return result;
}

static void regi_track_pose_sd(const reg_track *t, sb_real sd[2])
{
    sd[0] = t->def.pose_sd;
    sd[1] = t->def.pose_turn;
}

static sb_result regi_track_make(reg_track *t, sb_error *error)
{
    sb_real sd[2];
    regi_marks_def marks;
    sb_result result;
    t->node_count = t->model->mesh.node_count;
    t->skin_count = t->model->skin.node_count;
    regi_track_resolve(t);
    t->unknowns = t->def.modes + REGI_TRACK_POSE;
    t->wide = sbi_lanes_are_wide();
    t->response.model = t->model;
    t->look.size = t->model->size;
    marks = regi_track_marks_of(&t->def, t->def.landmarks, t->def.curves);
    regi_marks_count(&t->marks, &marks, t->model->size);
    result = regi_track_allocate(t, error);
    if (result == SB_OK)
        result = regi_track_place_marks(t, error);
    if (result == SB_OK)
        result = regi_track_cut_skin(t, error);
    if (result != SB_OK)
        return result;
    t->look.tree = t->tree;
    regi_track_shape_of(t, t->def.start, &t->def.pose);
    regi_track_pose_sd(t, sd);
    return regi_track_linearise(t, t->shape, sd, error);
}

REG_API sb_result reg_track_create(const reg_track_def *def, reg_track **track, sb_error *error)
{
    reg_track *made;
    sb_result result = regi_track_check(def, error);
    if (result == SB_OK && !track)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "no place for a tracker");
    if (result != SB_OK)
        return result;
    made = (reg_track *)sbi_alloc_zeroed(&def->model->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a tracker");
    made->allocator = def->model->allocator;
    made->model = def->model;
    made->def = *def;
    result = regi_track_make(made, error);
    made->def.start = NULL;
    made->def.landmarks = NULL;
    made->def.curves = NULL;
    if (result == SB_OK)
        *track = made;
    else
        reg_track_destroy(made);
    return result;
}

REG_API void reg_track_destroy(reg_track *track)
{
    sb_allocator allocator;
    if (!track)
        return;
    allocator = track->allocator;
    sb_direct_free(track->response.direct);
    sb_surface_destroy(track->tree);
    sb_embedding_rows_free(&track->marks.rows);
    sbi_free(&allocator, track->memory);
    sbi_free(&allocator, track);
}

REG_API sb_result reg_track_restart(reg_track *track, const reg_infer *start, sb_error *error)
{
    sb_real sd[2];
    if (!track || (start && start->model != track->model))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a restart needs a tracker, and no inference of another model");
    if (start)
        regi_track_shape_of(track, start, NULL);
    else
        (void)reg_track_displacements(track, track->shape);
    regi_track_pose_sd(track, sd);
    return regi_track_linearise(track, track->shape, sd, error);
}

/* ---- frames ---- */

REG_API sb_result reg_track_set_target(reg_track *track, const reg_points *target, sb_error *error)
{
    sb_result result;
    if (!track || !target || target->surface)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a tracker needs a target of points");
    result = regi_infer_check_points(target, error);
    if (result == SB_OK && target->count > track->def.most_points)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "%d points are more than the %d that the tracker has room for",
                          target->count, track->def.most_points);
    if (result != SB_OK)
        return result;
    for (int i = 0; i < target->count; i++)
        regi_look_take(track->incoming + i, target->points[i], target->normals ? target->normals[i] : sb_v3(0, 0, 0),
                       target->weights ? target->weights[i] : 1, target->sd ? target->sd[i] : 0);
    track->incoming_count = target->count;
    track->incoming_has_camera = target->has_camera;
    track->incoming_camera = target->camera;
    track->waiting = 1;
    return SB_OK;
}

REG_API sb_result reg_track_set_features(reg_track *track, const reg_landmark *landmarks, const reg_curve *curves,
                                         sb_error *error)
{
    regi_marks_def marks;
    sb_result result;
    if (!track || (track->def.landmark_count > 0 && !landmarks) || (track->def.curve_count > 0 && !curves))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "features need a tracker, and the landmarks and curves of its def");
    marks = regi_track_marks_of(&track->def, landmarks, curves);
    result = regi_marks_check_seen(&marks, track->known.place, 100 * track->model->size, error);
    if (result == SB_OK)
        regi_marks_see(&track->marks, &marks);
    return result;
}

/* 1 when a target agrees with nothing that was expected: its gaps are larger than what is usual, or far fewer of its
 * points can be believed. The first target is usual. */
static int regi_track_is_surprise(regi_track_known *next, const reg_track_info *info)
{
    sb_real fresh = next->usual_used > 0 ? (sb_real)0.1 : 1;
    if (fresh < 1 &&
        (info->innovation > 3 * sb_max(1, next->usual_innovation) || info->used < (sb_real)0.75 * next->usual_used))
        return 1;
    next->usual_used += fresh * (info->used - next->usual_used);
    next->usual_innovation += fresh * (info->innovation - next->usual_innovation);
    return 0;
}

/* next: whether the organ agrees with what was expected of it; three targets on end that do not are a jump. */
static void regi_track_judge(reg_track *t, int counted, reg_track_info *info)
{
    regi_track_known *next = &t->next;
    sb_real sd[2];
    info->state = REG_TRACK_PREDICTS;
    if (counted > 0)
        info->state = REG_TRACK_FOLLOWS;
    if (counted > 0 && t->waiting) {
        next->surprises = next->wide == 0 && regi_track_is_surprise(next, info) ? next->surprises + 1 : 0;
        next->wide -= next->wide > 0;
    }
    if (next->surprises == REGI_TRACK_SURPRISES) {
        regi_track_pose_sd(t, sd);
        regi_track_open(t, next, sd);
        info->state = REG_TRACK_JUMPED;
    }
    if (next->blind > t->def.lost_after)
        info->state = REG_TRACK_LOST;
}

static double regi_track_now(const reg_track *t) { return t->def.clock ? t->def.clock() : 0.0; }

REG_API sb_result reg_track_step(reg_track *track, double dt, reg_track_info *info)
{
    reg_track_info told;
    regi_track_known before;
    double begun;
    int counted = 0;
    sb_result result = SB_OK;
    memset(&told, 0, sizeof told);
    told.state = REG_TRACK_PREDICTS; /* of a step that fails: it took nothing in */
    if (!track || !(dt > 0) || !(dt <= 1e9)) {
        result = sbi_fail(&told.error, SB_ERROR_ARGUMENT, "a step needs a tracker and a dt above 0");
        if (info)
            *info = told;
        return result;
    }
    begun = regi_track_now(track);
    track->fresh = 1 - sbi_dense_exp(-dt / REGI_TRACK_FADES);
    regi_track_predict(track, dt);
    if (track->waiting || track->marks.fixed_count > 0 || track->marks.sample_count > 0)
        result = regi_track_take_in(track, &counted, &told);
    if (result == SB_OK) {
        regi_track_judge(track, counted, &told);
        before = track->known;
        track->known = track->next;
        track->next = before;
    }
    track->waiting = 0;
    regi_marks_forget(&track->marks);
    told.time = track->known.time;
    told.blind = track->known.blind;
    told.expected = regi_track_expected(track, &track->known);
    told.seconds = regi_track_now(track) - begun;
    if (info)
        *info = told;
    return result;
}

/* ---- where it is ---- */

REG_API sb_result reg_track_displacements(const reg_track *track, sb_vec3 *displacements)
{
    sb_mat3 rotation;
    if (!track || !displacements)
        return SB_ERROR_ARGUMENT;
    rotation = sb_quat_to_mat3(track->known.turned);
    memcpy(displacements, track->arms, (size_t)track->node_count * sizeof *displacements);
    for (int k = 0; k < track->def.modes; k++) {
        const sb_vec3 *mode = track->modes + (size_t)k * (size_t)track->node_count;
        for (int i = 0; i < track->node_count; i++)
            displacements[i] = sb_v3_madd(displacements[i], (sb_real)track->known.mean[k], mode[i]);
    }
    for (int i = 0; i < track->node_count; i++)
        displacements[i] = sb_v3_sub(sb_v3_add(track->known.place, sb_m3_apply(rotation, displacements[i])),
                                     track->model->mesh.nodes[i]);
    return SB_OK;
}

REG_API sb_result reg_track_covariances(const reg_track *track, sb_mat3 *covariances)
{
    double row[REGI_TRACK_UNKNOWNS];
    if (!track || !covariances)
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < track->node_count; i++)
        regi_track_covariance_of(track, i, row, covariances + i);
    return SB_OK;
}

REG_API const char *reg_track_state_string(reg_track_state state)
{
    switch (state) {
    case REG_TRACK_FOLLOWS: return "follows";
    case REG_TRACK_PREDICTS: return "predicts";
    case REG_TRACK_JUMPED: return "jumped";
    case REG_TRACK_LOST: return "lost";
    default: return "unknown state";
    }
}

#endif /* REG_IMPLEMENTATION */

/* ==== src/register/../softbody/end.h ==== */
/* end: gives back the settings that begin.h changed. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT DEFAULT
#elif defined(__GNUC__)
#if !defined(__STRICT_ANSI__) && (defined(__FP_FAST_FMA) || defined(__FP_FAST_FMAF))
#pragma GCC pop_options
#endif
#endif

/*
softbody is available under two licences; choose the one you like.

------------------------------------------------------------------------------
ALTERNATIVE A - MIT License

Copyright (c) 2025 the softbody authors

Permission is hereby granted, free of charge, to any person obtaining a copy of
this software and associated documentation files (the "Software"), to deal in
the Software without restriction, including without limitation the rights to
use, copy, modify, merge, publish, distribute, sublicense, and/or sell copies
of the Software, and to permit persons to whom the Software is furnished to do
so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all
copies or substantial portions of the Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR
IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY,
FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
AUTHORS OR COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER
LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM,
OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE
SOFTWARE.

------------------------------------------------------------------------------
ALTERNATIVE B - Public Domain (www.unlicense.org)

This is free and unencumbered software released into the public domain.

Anyone is free to copy, modify, publish, use, compile, sell, or distribute this
software, either in source code form or as a compiled binary, for any purpose,
commercial or non-commercial, and by any means.

In jurisdictions that recognize copyright laws, the author or authors of this
software dedicate any and all copyright interest in the software to the public
domain. We make this dedication for the benefit of the public at large and to
the detriment of our heirs and successors. We intend this dedication to be an
overt act of relinquishment in perpetuity of all present and future rights to
this software under copyright law.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR
IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY,
FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
AUTHORS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN
ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION
WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE.
*/
