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
