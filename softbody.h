/* softbody.h 0.1.0: soft-tissue simulation, from an organ's mesh to forces and pictures
 * MIT or public domain, as you like; the texts are at the end of this file.
 * Generated from src/softbody/: edit there, then run `make headers`. */

/* ==== src/softbody/softbody_doc.h ==== */
/*
 * softbody.h - soft-tissue physics for surgical trainers and image-guided surgery, in one header.
 *
 * Loads a volume mesh of an organ (or makes one), gives it a material, moves it in real time or finds its
 * equilibrium, and lets you read forces and stresses. C99 or C++11, libc and libm, nothing else.
 *
 * HOW TO INCLUDE
 *
 * In one C or C++ file:
 *
 *     #define SB_IMPLEMENTATION
 *     #include "softbody.h"
 *
 * and in all others only the second line. Link with -lm. Optimise (-O2 or -O3, and -march=native or your target's
 * vector flags if you can): the loops are written to be vectorised.
 *
 * OPTIONS (define before including, the same in every file)
 *
 *     SB_REAL            double (default) or float. The exported names of a float build end in _f32.
 *     SB_STATIC          everything static: two libraries in one process never clash. Put SB_IMPLEMENTATION in each
 *                        file that includes the header then.
 *     SB_ELEMENT         SB_TET4, SB_TET10 or SB_HEX8: compile the loops of this element only. Other elements are
 *                        refused with SB_ERROR_UNSUPPORTED. Default: all.
 *     SB_USE_OPENMP      with -fopenmp: sb_jobs_openmp() spreads the loops over OpenMP's threads.
 *     SB_ASSERT(c)       what checks the library's own invariants; default nothing. Bad input never reaches it.
 *     SB_NO_VECTORS      no compiler vector types in the preconditioner: plain loops, the same bits, slower.
 *     SB_ALLOW_FAST_MATH insist on -ffast-math, which otherwise is an error: it breaks determinism and NaN checks.
 *
 * WHAT IT DOES NOT DO
 *
 * No collision detection, cutting, needles, surface meshing or rendering in this version; no quadratic hexahedra; no
 * saved state that continues to the same bits (displacements and velocities can be set, which continues up to rounding).
 * A linearised step (the real-time default) trades accuracy within a step for a bounded frame time.
 *
 * A FIRST PROGRAM
 *
 * A beam, clamped at one end, sags under its weight; then the same as a static solve:
 *
 *     ```c
 *     #define SB_IMPLEMENTATION
 *     #include "softbody.h"
 *     #include <stdio.h>
 *
 *     static int fail(const sb_error *error)
 *     {
 *         fprintf(stderr, "%s: %s\n", sb_result_string(error->result), error->message);
 *         return 1;
 *     }
 *
 *     int main(void)
 *     {
 *         sb_mesh mesh = {0};
 *         sb_error error;
 *         if (sb_mesh_beam(SB_TET10, 10, 3, 3, sb_v3(0.2, 0.06, 0.06), NULL, &mesh, &error) != SB_OK)
 *             return fail(&error);
 *
 *         sb_body_def def = sb_default_body_def();
 *         def.mesh = &mesh;
 *         def.material = sb_material_corotated(50e3, 0.45, 1000);   // E (Pa), Poisson's ratio, density (kg/m^3)
 *         def.gravity = sb_v3(0, 0, -9.81);
 *         def.damping_stiffness = 0.02;                             // Rayleigh beta (s)
 *         sb_body *body = NULL;
 *         if (sb_body_create(&def, &body, &error) != SB_OK)
 *             return fail(&error);
 *
 *         for (int i = 0; i < mesh.node_count; i++)                 // clamp the end at x = 0
 *             if (mesh.nodes[i].x < 1e-9 && sb_body_fix_nodes(body, &i, 1, SB_XYZ) != SB_OK)
 *                 return 1;
 *
 *         sb_step_info info;
 *         for (int frame = 0; frame < 60; frame++)
 *             if (sb_body_step(body, 1.0 / 60, &info) != SB_OK)
 *                 return fail(&info.error);
 *         int tip = mesh.node_count - 1;
 *         printf("after a second: %.2f mm\n", 1e3 * sb_body_displacements(body)[tip].z);
 *
 *         if (sb_body_solve_static(body, NULL, &info) != SB_OK)
 *             return fail(&info.error);
 *         printf("at rest: %.2f mm after %d Newton iterations\n", 1e3 * sb_body_displacements(body)[tip].z,
 *                info.newton_iterations);
 *         sb_body_destroy(body);
 *         sb_mesh_free(&mesh);
 *         return 0;
 *     }
 *     ```
 *
 * CONCEPTS
 *
 * Units are SI: metre, kilogram, second, newton, pascal. Files in millimetres: sb_load_options.scale = 0.001.
 *
 * sb_mesh      nodes and elements of one type: tet4, tet10, hex8 (volumes), tri3, tri6, quad4 (surfaces), with
 *              VTK's node orders. Plain arrays: load them (sb_mesh_load), generate them (sb_mesh_beam, _cylinder,
 *              _ellipsoid, _organ) or fill them yourself. `regions` tells materials apart.
 * sb_material  a model and its parameters; made by sb_material_corotated() and others.
 * sb_body      a mesh with materials, supports, loads and a state of motion. Created from a def, stepped, read.
 * supports     degrees of freedom that follow a target: sb_body_fix_nodes holds, sb_body_prescribe moves (a tool).
 * loads        gravity, nodal forces, tractions; dead loads that stay until sb_body_clear_loads.
 *
 * Which material? sb_material_corotated for real time up to large rotations and moderate strains: it survives any
 * shape, inside out included. sb_material_stable_neo_hookean for large strains that must survive too.
 * sb_material_neo_hookean, _neo_hookean_isochoric and _svk to agree with textbooks and industrial solvers.
 *
 * Which element? tet10 bends well and does not lock; tet4 is fastest per element but too stiff in bending and near
 * incompressibility (nu above 0.49); hex8 for structured blocks. def.single_rotation makes tet10 cheaper.
 *
 * Which integrator? SB_EULER for trainers. SB_GENERALISED_ALPHA for studies of large or fast motion, SB_NEWMARK for small
 * motion that must keep its energy, SB_CENTRAL_DIFFERENCE where many short cheap steps pay: soft tissue, coarse meshes.
 *
 * An organ from a file, held at its top, pulled by a tool, its force read:
 *
 *     ```c fragment
 *     sb_mesh organ = {0};
 *     sb_error error;
 *     if (sb_mesh_load(&organ, "liver.vtk", NULL, &error) != SB_OK) {
 *         fprintf(stderr, "%s:%d: %s\n", error.file, error.line, error.message);
 *         return 1;
 *     }
 *     sb_mesh_reorder(&organ, NULL, NULL, NULL);          // better cache use, fewer iterations
 *
 *     sb_body_def def = sb_default_body_def();
 *     def.mesh = &organ;
 *     def.material = sb_material_stable_neo_hookean(5e3, 0.45, 1060);
 *     sb_body *body = NULL;
 *     if (sb_body_create(&def, &body, &error) != SB_OK)
 *         return 1;
 *
 *     sb_check_report report;                             // units, slivers, missing supports?
 *     sb_body_check(body, &report);
 *     for (unsigned bit = 1; bit <= SB_CHECK_DUPLICATES; bit <<= 1)
 *         if (report.warnings & bit)
 *             fprintf(stderr, "warning: %s\n", sb_check_string(bit));
 *
 *     sb_vec3 low, high;
 *     sb_mesh_bounds(&organ, &low, &high);
 *     int tool = 0;                                       // the lowest node is what the tool grips
 *     for (int i = 0; i < organ.node_count; i++) {
 *         if (organ.nodes[i].z > low.z + (sb_real)0.9 * (high.z - low.z))
 *             sb_body_fix_nodes(body, &i, 1, SB_XYZ);
 *         if (organ.nodes[i].z < organ.nodes[tool].z)
 *             tool = i;
 *     }
 *     for (int frame = 0; frame < 30; frame++) {
 *         sb_vec3 pull = sb_v3(0, 0, (sb_real)(-0.0003 * frame));
 *         sb_step_info info;
 *         sb_body_prescribe(body, &tool, 1, SB_XYZ, &pull, 1);
 *         if (sb_body_step(body, (sb_real)(1.0 / 60), &info) != SB_OK)
 *             fprintf(stderr, "frame %d: %s\n", frame, info.error.message);   // the step was undone; go on
 *     }
 *     sb_vec3 force = sb_body_reactions(body)[tool];      // what the tool exerts on the organ (N)
 *     printf("pulling with %.3f N\n", -(double)force.z);
 *
 *     sb_field field = {"displacement", SB_FIELD_NODES, 3, &sb_body_displacements(body)[0].x};
 *     sb_mesh_save_vtk("pulled.vtk", &organ, &field, 1, NULL);
 *     sb_body_destroy(body);
 *     sb_mesh_free(&organ);
 *     ```
 *
 * ERRORS
 *
 * Calls that can fail return an sb_result: SB_OK (0) or a negative SB_ERROR_. They leave their outputs untouched
 * then, and fill an optional sb_error: a sentence with file and line, element or node. Nothing prints, exits or
 * aborts. A step that fails is undone: the body is as before the call and can go on.
 *
 * MEMORY
 *
 * Every object takes an sb_allocator ({0}: malloc). All memory for stepping is taken at creation and when supports
 * are added; a step allocates nothing. When the allocator returns NULL the call fails with SB_ERROR_MEMORY and
 * nothing leaks.
 *
 * THREADS
 *
 * No globals. Different objects may be used from different threads; one object by one thread at a time. A body's own
 * loops spread over the threads behind def.jobs: give it your job system's run function, or sb_jobs_openmp().
 *
 * DETERMINISM
 *
 * The same input gives the same bits with any number of threads, and with any compiler and optimisation that does
 * IEEE arithmetic without contraction: clang is told so here; with gcc compile as -std=c99 or -ffp-contract=off where
 * fused multiply-add exists (the header asks for it where it can).
 *
 * REFERENCE
 *
 * The declarations below are the reference, room by room: core (results, allocator, jobs), dense (vectors, matrices,
 * decompositions), element, mesh, meshgen, meshio, material, sparse, precond, pcg, domain, body, step, modes.
 */

/* ==== src/softbody/begin.h ==== */
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
#endif
#pragma GCC push_options
#pragma GCC optimize("fp-contract=off")
#endif
#elif defined(_MSC_VER) && defined(SB_IMPLEMENTATION)
#pragma fp_contract(off)
#endif

#ifndef SOFTBODY_H
#define SOFTBODY_H

/* ==== src/softbody/names.h ==== */
/* names: the exported names of a float build end in _f32, so that a float caller and a double object do
 * not link. Written by src/amalgamate.c from the declarations: do not edit. */
#ifndef SBI_NAMES_H
#define SBI_NAMES_H

#if defined(SB_REAL)
#define SBI_NAMES_PASTE_(a, b) a##b
#define SBI_NAMES_PASTE(a, b) SBI_NAMES_PASTE_(a, b)
#define SBI_NAMES_OF_double 0
#define SBI_NAMES_OF_float 1
#if SBI_NAMES_PASTE(SBI_NAMES_OF_, SB_REAL)
#define sb_result_string sb_result_string_f32
#define sb_jobs_openmp sb_jobs_openmp_f32
#define sb_element_name sb_element_name_f32
#define sb_element_face sb_element_face_f32
#define sb_element_edge sb_element_edge_f32
#define sb_element_node_point sb_element_node_point_f32
#define sb_element_shape sb_element_shape_f32
#define sb_element_quadrature sb_element_quadrature_f32
#define sb_mesh_free sb_mesh_free_f32
#define sb_mesh_copy sb_mesh_copy_f32
#define sb_mesh_validate sb_mesh_validate_f32
#define sb_mesh_check sb_mesh_check_f32
#define sb_mesh_report_free sb_mesh_report_free_f32
#define sb_mesh_element_volume sb_mesh_element_volume_f32
#define sb_mesh_volume sb_mesh_volume_f32
#define sb_mesh_surface_area sb_mesh_surface_area_f32
#define sb_mesh_bounds sb_mesh_bounds_f32
#define sb_mesh_element_quality sb_mesh_element_quality_f32
#define sb_mesh_orient sb_mesh_orient_f32
#define sb_mesh_orient_surface sb_mesh_orient_surface_f32
#define sb_mesh_merge_nodes sb_mesh_merge_nodes_f32
#define sb_mesh_remove_unreferenced sb_mesh_remove_unreferenced_f32
#define sb_mesh_remove_duplicate_elements sb_mesh_remove_duplicate_elements_f32
#define sb_mesh_scale sb_mesh_scale_f32
#define sb_index_table_free sb_index_table_free_f32
#define sb_index_lists_free sb_index_lists_free_f32
#define sb_boundary_free sb_boundary_free_f32
#define sb_mesh_boundary sb_mesh_boundary_f32
#define sb_mesh_neighbours sb_mesh_neighbours_f32
#define sb_mesh_edges sb_mesh_edges_f32
#define sb_mesh_node_elements sb_mesh_node_elements_f32
#define sb_mesh_components sb_mesh_components_f32
#define sb_mesh_to_tet10 sb_mesh_to_tet10_f32
#define sb_mesh_reorder sb_mesh_reorder_f32
#define sb_mesh_beam sb_mesh_beam_f32
#define sb_mesh_cylinder sb_mesh_cylinder_f32
#define sb_mesh_ellipsoid sb_mesh_ellipsoid_f32
#define sb_mesh_organ sb_mesh_organ_f32
#define sb_default_load_options sb_default_load_options_f32
#define sb_mesh_load sb_mesh_load_f32
#define sb_mesh_load_memory sb_mesh_load_memory_f32
#define sb_mesh_save_vtk sb_mesh_save_vtk_f32
#define sb_mesh_save_vtk_binary sb_mesh_save_vtk_binary_f32
#define sb_mesh_save_obj sb_mesh_save_obj_f32
#define sb_mesh_save_stl sb_mesh_save_stl_f32
#define sb_mesh_save_ply sb_mesh_save_ply_f32
#define sb_material_linear sb_material_linear_f32
#define sb_material_corotated sb_material_corotated_f32
#define sb_material_corotated_invertible sb_material_corotated_invertible_f32
#define sb_material_svk sb_material_svk_f32
#define sb_material_neo_hookean sb_material_neo_hookean_f32
#define sb_material_stable_neo_hookean sb_material_stable_neo_hookean_f32
#define sb_material_neo_hookean_isochoric sb_material_neo_hookean_isochoric_f32
#define sb_material_young sb_material_young_f32
#define sb_material_poisson sb_material_poisson_f32
#define sb_material_bulk sb_material_bulk_f32
#define sb_material_check sb_material_check_f32
#define sb_material_allows_inversion sb_material_allows_inversion_f32
#define sb_material_is_linear sb_material_is_linear_f32
#define sb_material_energy sb_material_energy_f32
#define sb_material_stress sb_material_stress_f32
#define sb_material_tangent sb_material_tangent_f32
#define sb_cauchy_stress sb_cauchy_stress_f32
#define sb_material_cauchy_stress sb_material_cauchy_stress_f32
#define sb_von_mises sb_von_mises_f32
#define sb_matrix_create sb_matrix_create_f32
#define sb_matrix_free sb_matrix_free_f32
#define sb_matrix_clear sb_matrix_clear_f32
#define sb_matrix_find sb_matrix_find_f32
#define sb_matrix_multiply sb_matrix_multiply_f32
#define sb_matrix_asymmetry sb_matrix_asymmetry_f32
#define sb_matrix_diagonal_scale sb_matrix_diagonal_scale_f32
#define sb_matrix_constrain sb_matrix_constrain_f32
#define sb_default_preconditioner_def sb_default_preconditioner_def_f32
#define sb_preconditioner_create sb_preconditioner_create_f32
#define sb_preconditioner_free sb_preconditioner_free_f32
#define sb_preconditioner_update sb_preconditioner_update_f32
#define sb_preconditioner_apply sb_preconditioner_apply_f32
#define sb_preconditioner_get_info sb_preconditioner_get_info_f32
#define sb_default_pcg_options sb_default_pcg_options_f32
#define sb_pcg_workspace_create sb_pcg_workspace_create_f32
#define sb_pcg_workspace_free sb_pcg_workspace_free_f32
#define sb_pcg_solve sb_pcg_solve_f32
#define sb_domain_create sb_domain_create_f32
#define sb_domain_free sb_domain_free_f32
#define sb_default_body_def sb_default_body_def_f32
#define sb_body_create sb_body_create_f32
#define sb_body_destroy sb_body_destroy_f32
#define sb_body_node_count sb_body_node_count_f32
#define sb_body_element_count sb_body_element_count_f32
#define sb_body_point_count sb_body_point_count_f32
#define sb_body_matrix_blocks sb_body_matrix_blocks_f32
#define sb_body_set_material sb_body_set_material_f32
#define sb_body_set_region_material sb_body_set_region_material_f32
#define sb_body_set_gravity sb_body_set_gravity_f32
#define sb_body_set_damping sb_body_set_damping_f32
#define sb_body_set_solver sb_body_set_solver_f32
#define sb_body_fix_nodes sb_body_fix_nodes_f32
#define sb_body_prescribe sb_body_prescribe_f32
#define sb_body_release_nodes sb_body_release_nodes_f32
#define sb_body_supports sb_body_supports_f32
#define sb_body_add_forces sb_body_add_forces_f32
#define sb_body_add_traction sb_body_add_traction_f32
#define sb_body_clear_loads sb_body_clear_loads_f32
#define sb_body_positions sb_body_positions_f32
#define sb_body_displacements sb_body_displacements_f32
#define sb_body_velocities sb_body_velocities_f32
#define sb_body_set_displacements sb_body_set_displacements_f32
#define sb_body_set_velocities sb_body_set_velocities_f32
#define sb_body_reset sb_body_reset_f32
#define sb_body_reactions sb_body_reactions_f32
#define sb_body_external_forces sb_body_external_forces_f32
#define sb_body_energy sb_body_energy_f32
#define sb_body_mass sb_body_mass_f32
#define sb_body_momentum sb_body_momentum_f32
#define sb_body_stress sb_body_stress_f32
#define sb_body_von_mises sb_body_von_mises_f32
#define sb_body_nodal_von_mises sb_body_nodal_von_mises_f32
#define sb_body_check sb_body_check_f32
#define sb_check_string sb_check_string_f32
#define sb_body_step sb_body_step_f32
#define sb_body_stable_step sb_body_stable_step_f32
#define sb_default_static_options sb_default_static_options_f32
#define sb_body_solve_static sb_body_solve_static_f32
#define sb_default_modes_options sb_default_modes_options_f32
#define sb_body_modes sb_body_modes_f32
#endif
#endif

#endif /* SBI_NAMES_H */

/* ==== src/softbody/core.h ==== */
/* core: configuration, results, errors, allocator, jobs. Floor 0: calls nothing but libc. */
#ifndef SB_CORE_H
#define SB_CORE_H

#include <stddef.h>
#include <stdint.h>


#define SB_VERSION_MAJOR 0
#define SB_VERSION_MINOR 1
#define SB_VERSION_PATCH 0
#define SB_VERSION_STRING "0.1.0"

#if defined(__FAST_MATH__) && !defined(SB_ALLOW_FAST_MATH)
#error "softbody.h: -ffast-math breaks determinism and NaN checks; define SB_ALLOW_FAST_MATH to insist"
#endif

/* ---- scalar type ------------------------------------------------------------------------------------
 * SB_REAL is double unless the user defines it as float before including. The public functions of a float
 * build carry the suffix _f32 (see names.h), so a float caller and a double object fail at link time. */
#ifndef SB_REAL
#define SB_REAL double
#endif
#define SBI_PASTE_(a, b) a##b
#define SBI_PASTE(a, b) SBI_PASTE_(a, b)
#define SBI_REAL_CODE_double 1
#define SBI_REAL_CODE_float 2
#if SBI_PASTE(SBI_REAL_CODE_, SB_REAL) == 1
#define SB_REAL_IS_FLOAT 0
#elif SBI_PASTE(SBI_REAL_CODE_, SB_REAL) == 2
#define SB_REAL_IS_FLOAT 1
#else
#error "softbody.h: SB_REAL must be double or float"
#endif
typedef SB_REAL sb_real;

#if SB_REAL_IS_FLOAT
#define SB_EPSILON 1.1920929e-7f /* distance from 1 to the next sb_real */
#define SB_REAL_MAX 3.4028234e38f
#else
#define SB_EPSILON 2.220446049250313e-16
#define SB_REAL_MAX 1.7976931348623157e308
#endif

/* ---- linkage ----------------------------------------------------------------------------------------
 * SB_API: public functions; SB_STATIC makes them static, so that two libraries in one process never clash.
 * SBI_API: internal functions; static in the shipped header, extern when the rooms are compiled apart. */
#if defined(__GNUC__)
#define SBI_UNUSED __attribute__((unused))
#else
#define SBI_UNUSED
#endif
#if defined(SB_STATIC)
#define SB_API static SBI_UNUSED
#elif defined(__cplusplus)
#define SB_API extern "C"
#else
#define SB_API extern
#endif
#if defined(SB_SPLIT_BUILD)
#define SBI_API extern
#else
#define SBI_API static SBI_UNUSED
#endif

/* SB_INLINE: small public functions defined in the header itself. */
#if defined(__GNUC__)
#define SB_INLINE static inline SBI_UNUSED
#define SBI_FORCE_INLINE static inline __attribute__((always_inline, unused))
#else
#define SB_INLINE static inline
#define SBI_FORCE_INLINE static inline
#endif

/* SB_RESTRICT: the pointer's target is reached through no other pointer of the function. */
#if defined(__cplusplus)
#if defined(__GNUC__) || defined(_MSC_VER)
#define SB_RESTRICT __restrict
#else
#define SB_RESTRICT
#endif
#else
#define SB_RESTRICT restrict
#endif

/* SB_ASSERT: our own invariants only; bad input never reaches one. Replace it or leave it off (default). */
#ifndef SB_ASSERT
#define SB_ASSERT(condition) ((void)0)
#endif

/* ---- results and errors ------------------------------------------------------------------------------
 * Every call that can fail returns an sb_result and leaves its outputs untouched on failure. */
typedef enum sb_result {
    SB_OK = 0,
    SB_ERROR_MEMORY = -1,        /* the allocator returned NULL, or a size does not fit size_t */
    SB_ERROR_ARGUMENT = -2,      /* null pointer, count, enum or parameter outside its documented range */
    SB_ERROR_NOT_FINITE = -3,    /* NaN or infinity in an input */
    SB_ERROR_INDEX = -4,         /* node, element or region index out of range */
    SB_ERROR_FILE = -5,          /* a file cannot be opened, read or written */
    SB_ERROR_FORMAT = -6,        /* a file breaks the rules of its format */
    SB_ERROR_UNSUPPORTED = -7,   /* valid, but outside what this library reads or solves */
    SB_ERROR_MESH = -8,          /* inverted, flat or degenerate element, repeated node, empty mesh */
    SB_ERROR_MATERIAL = -9,      /* material parameters outside their range */
    SB_ERROR_UNCONSTRAINED = -10,/* a static problem whose supports leave a rigid motion free */
    SB_ERROR_INVERTED = -11,     /* an element turned inside out where the material does not allow it */
    SB_ERROR_DIVERGED = -12,     /* a solve found no acceptable step, or NaN appeared; the state was restored */
    SB_ERROR_NOT_CONVERGED = -13,/* an iteration limit was reached before the tolerance */
    SB_ERROR_INDEFINITE = -14    /* a matrix that must be positive definite is not */
} sb_result;

/* Where and why a call failed. Fields that do not apply are -1 (line: 0) or empty. Plain data; zero-initialise
 * or leave uninitialised, a failing call writes every field. */
typedef struct sb_error {
    sb_result result;
    int line;            /* line in `file`, from 1; 0 when there is none */
    int element;         /* element index, or -1 */
    int node;            /* node index, or -1 */
    char file[256];      /* path as given, cut at the front when longer */
    char message[256];   /* one sentence, e.g. "node 12 has a coordinate that is not finite" */
} sb_error;

/* Name of a result, e.g. "SB_ERROR_MEMORY"; never NULL. Thread-safe, static storage. */
SB_API const char *sb_result_string(sb_result result);

/* ---- memory -------------------------------------------------------------------------------------------
 * alloc returns at least `bytes` bytes aligned for any scalar type, or NULL; release accepts NULL. An
 * allocator of zeros ({0}) means malloc and free. */
typedef struct sb_allocator {
    void *(*alloc)(void *user, size_t bytes);
    void (*release)(void *user, void *pointer);
    void *user;
} sb_allocator;

/* ---- threads ------------------------------------------------------------------------------------------
 * run must call task(task_user, i) once for every i in [0, count), in any order and on any threads, and return
 * when all calls have returned. A jobs of zeros ({0}) does the work inline. The result does not depend on how
 * the calls are spread: every task owns its outputs. */
typedef void (*sb_task)(void *task_user, int index);
typedef struct sb_jobs {
    void (*run)(void *user, sb_task task, void *task_user, int count);
    void *user;
} sb_jobs;

#if defined(SB_USE_OPENMP)
/* Jobs on OpenMP's threads (compile the implementation with -fopenmp). */
SB_API sb_jobs sb_jobs_openmp(void);
#endif

/* ---- time ---------------------------------------------------------------------------------------------
 * A clock the host may lend for per-phase times: seconds since any fixed moment. NULL: times read 0. */
typedef double (*sb_clock)(void);

/* ---- internal: checked sizes, errors, allocation --------------------------------------------------------- */

/* One block shared by many arrays. Walk the same list of sbi_arena_take calls twice: with base NULL to measure
 * (`used` grows, `overflow` is set when a size does not fit), then with base set to hand the pieces out, each
 * aligned to a cache line (64 bytes) when base is. */
typedef struct sbi_arena {
    unsigned char *base;
    size_t used;
    int overflow;
} sbi_arena;

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* *total += count * size; 0 when the sum does not fit size_t (then *total is unchanged), else 1. */
SBI_API int sbi_size_add(size_t *total, size_t count, size_t size);
/* Memory for count items of `size` bytes, or NULL (also when count * size overflows). Never asks for 0 bytes. */
SBI_API void *sbi_alloc(const sb_allocator *allocator, size_t count, size_t size);
SBI_API void *sbi_alloc_zeroed(const sb_allocator *allocator, size_t count, size_t size);
SBI_API void sbi_free(const sb_allocator *allocator, void *pointer);
SBI_API void *sbi_arena_take(sbi_arena *arena, size_t count, size_t size);
/* Runs the task over [0, count) on jobs, inline when jobs is NULL or empty. */
SBI_API void sbi_run(const sb_jobs *jobs, sb_task task, void *task_user, int count);
/* Fills error (may be NULL) and returns result. The format is printf's. */
SBI_API sb_result sbi_fail(sb_error *error, sb_result result, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 3, 4)))
#endif
    ;
SBI_API sb_result sbi_fail_element(sb_error *error, sb_result result, int element, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 4, 5)))
#endif
    ;
SBI_API sb_result sbi_fail_node(sb_error *error, sb_result result, int node, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 4, 5)))
#endif
    ;
#endif

SB_INLINE int sbi_min_int(int a, int b) { return a < b ? a : b; }
SB_INLINE int sbi_max_int(int a, int b) { return a > b ? a : b; }
/* 1 when x is neither NaN nor infinite. */
SB_INLINE int sb_is_finite(sb_real x) { return x - x == (sb_real)0; }

#endif /* SB_CORE_H */

/* ==== src/softbody/dense.h ==== */
/* dense: 3-vectors, 3x3 matrices, quaternions, their decompositions, small dense systems, and scalar
 * functions that give the same bits everywhere. Floor 0. All static inline, public: needle.h and register.h
 * share them. Matrices are row-major, m[row][column]. All is thread-safe and allocates nothing. */
#ifndef SB_DENSE_H
#define SB_DENSE_H

#include <math.h>
#include <string.h>


typedef struct sb_vec3 {
    sb_real x, y, z;
} sb_vec3;

typedef struct sb_mat3 {
    sb_real m[3][3];
} sb_mat3;

/* Unit quaternion w + xi + yj + zk of a rotation. */
typedef struct sb_quat {
    sb_real w, x, y, z;
} sb_quat;

/* Scalar functions of libm in the precision of sb_real. sqrt is exactly rounded, so it is the same
 * everywhere; other libm functions are not and stay out of stepping code (see sb_log, sb_cbrt ... below). */
#if SB_REAL_IS_FLOAT
SB_INLINE sb_real sb_sqrt(sb_real x) { return sqrtf(x); }
SB_INLINE sb_real sb_abs(sb_real x) { return fabsf(x); }
#else
SB_INLINE sb_real sb_sqrt(sb_real x) { return sqrt(x); }
SB_INLINE sb_real sb_abs(sb_real x) { return fabs(x); }
#endif
SB_INLINE sb_real sb_min(sb_real a, sb_real b) { return a < b ? a : b; }
SB_INLINE sb_real sb_max(sb_real a, sb_real b) { return a > b ? a : b; }

/* ---- 3-vectors ---- */

SB_INLINE sb_vec3 sb_v3(sb_real x, sb_real y, sb_real z)
{
    sb_vec3 v;
    v.x = x;
    v.y = y;
    v.z = z;
    return v;
}
SB_INLINE sb_vec3 sb_v3_add(sb_vec3 a, sb_vec3 b) { return sb_v3(a.x + b.x, a.y + b.y, a.z + b.z); }
SB_INLINE sb_vec3 sb_v3_sub(sb_vec3 a, sb_vec3 b) { return sb_v3(a.x - b.x, a.y - b.y, a.z - b.z); }
SB_INLINE sb_vec3 sb_v3_scale(sb_real s, sb_vec3 a) { return sb_v3(s * a.x, s * a.y, s * a.z); }
/* a + s b */
SB_INLINE sb_vec3 sb_v3_madd(sb_vec3 a, sb_real s, sb_vec3 b)
{
    return sb_v3(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z);
}
SB_INLINE sb_real sb_v3_dot(sb_vec3 a, sb_vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
SB_INLINE sb_vec3 sb_v3_cross(sb_vec3 a, sb_vec3 b)
{
    return sb_v3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
SB_INLINE sb_real sb_v3_norm(sb_vec3 a) { return sb_sqrt(sb_v3_dot(a, a)); }
SB_INLINE int sb_v3_is_finite(sb_vec3 a)
{
    return sb_is_finite(a.x) && sb_is_finite(a.y) && sb_is_finite(a.z);
}

/* ---- 3x3 matrices ---- */

SB_INLINE sb_mat3 sb_m3_zero(void)
{
    sb_mat3 a;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            a.m[i][j] = 0;
    return a;
}
SB_INLINE sb_mat3 sb_m3_identity(void)
{
    sb_mat3 a = sb_m3_zero();
    a.m[0][0] = a.m[1][1] = a.m[2][2] = 1;
    return a;
}
/* Matrix with columns a, b, c. */
SB_INLINE sb_mat3 sb_m3_columns(sb_vec3 a, sb_vec3 b, sb_vec3 c)
{
    sb_mat3 r;
    r.m[0][0] = a.x, r.m[0][1] = b.x, r.m[0][2] = c.x;
    r.m[1][0] = a.y, r.m[1][1] = b.y, r.m[1][2] = c.y;
    r.m[2][0] = a.z, r.m[2][1] = b.z, r.m[2][2] = c.z;
    return r;
}
SB_INLINE sb_vec3 sb_m3_column(sb_mat3 a, int j) { return sb_v3(a.m[0][j], a.m[1][j], a.m[2][j]); }
SB_INLINE sb_mat3 sb_m3_add(sb_mat3 a, sb_mat3 b)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            a.m[i][j] += b.m[i][j];
    return a;
}
SB_INLINE sb_mat3 sb_m3_sub(sb_mat3 a, sb_mat3 b)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            a.m[i][j] -= b.m[i][j];
    return a;
}
SB_INLINE sb_mat3 sb_m3_scale(sb_real s, sb_mat3 a)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            a.m[i][j] *= s;
    return a;
}
SB_INLINE sb_mat3 sb_m3_transpose(sb_mat3 a)
{
    sb_mat3 r;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            r.m[i][j] = a.m[j][i];
    return r;
}
/* a b */
SB_INLINE sb_mat3 sb_m3_mul(sb_mat3 a, sb_mat3 b)
{
    sb_mat3 r;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            r.m[i][j] = a.m[i][0] * b.m[0][j] + a.m[i][1] * b.m[1][j] + a.m[i][2] * b.m[2][j];
    return r;
}
/* a^T b */
SB_INLINE sb_mat3 sb_m3_tmul(sb_mat3 a, sb_mat3 b)
{
    sb_mat3 r;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            r.m[i][j] = a.m[0][i] * b.m[0][j] + a.m[1][i] * b.m[1][j] + a.m[2][i] * b.m[2][j];
    return r;
}
/* a b^T */
SB_INLINE sb_mat3 sb_m3_mult(sb_mat3 a, sb_mat3 b)
{
    sb_mat3 r;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            r.m[i][j] = a.m[i][0] * b.m[j][0] + a.m[i][1] * b.m[j][1] + a.m[i][2] * b.m[j][2];
    return r;
}
/* a v */
SB_INLINE sb_vec3 sb_m3_apply(sb_mat3 a, sb_vec3 v)
{
    return sb_v3(a.m[0][0] * v.x + a.m[0][1] * v.y + a.m[0][2] * v.z,
                 a.m[1][0] * v.x + a.m[1][1] * v.y + a.m[1][2] * v.z,
                 a.m[2][0] * v.x + a.m[2][1] * v.y + a.m[2][2] * v.z);
}
/* a^T v */
SB_INLINE sb_vec3 sb_m3_tapply(sb_mat3 a, sb_vec3 v)
{
    return sb_v3(a.m[0][0] * v.x + a.m[1][0] * v.y + a.m[2][0] * v.z,
                 a.m[0][1] * v.x + a.m[1][1] * v.y + a.m[2][1] * v.z,
                 a.m[0][2] * v.x + a.m[1][2] * v.y + a.m[2][2] * v.z);
}
/* u v^T */
SB_INLINE sb_mat3 sb_m3_outer(sb_vec3 u, sb_vec3 v)
{
    return sb_m3_columns(sb_v3_scale(v.x, u), sb_v3_scale(v.y, u), sb_v3_scale(v.z, u));
}
SB_INLINE sb_real sb_m3_trace(sb_mat3 a) { return a.m[0][0] + a.m[1][1] + a.m[2][2]; }
/* A:B = sum A_ij B_ij */
SB_INLINE sb_real sb_m3_ddot(sb_mat3 a, sb_mat3 b)
{
    sb_real sum = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            sum += a.m[i][j] * b.m[i][j];
    return sum;
}
/* Cofactor matrix: columns f1 x f2, f2 x f0, f0 x f1 of the columns f; det(a) a^-T where that exists. */
SB_INLINE sb_mat3 sb_m3_cofactor(sb_mat3 a)
{
    sb_vec3 c0 = sb_m3_column(a, 0), c1 = sb_m3_column(a, 1), c2 = sb_m3_column(a, 2);
    return sb_m3_columns(sb_v3_cross(c1, c2), sb_v3_cross(c2, c0), sb_v3_cross(c0, c1));
}
SB_INLINE sb_real sb_m3_det(sb_mat3 a)
{
    return sb_v3_dot(sb_m3_column(a, 0), sb_v3_cross(sb_m3_column(a, 1), sb_m3_column(a, 2)));
}
/* Inverse; the caller makes sure that det(a) is not 0. */
SB_INLINE sb_mat3 sb_m3_inverse(sb_mat3 a)
{
    return sb_m3_scale((sb_real)1 / sb_m3_det(a), sb_m3_transpose(sb_m3_cofactor(a)));
}

/* ---- scalar functions with the same bits everywhere -------------------------------------------------------
 * libm's exp, log, sin ... differ between systems; these are built from + - * /, sqrt and moves of bits only,
 * so every compiler and -O level gives the same bits as long as it neither contracts a*b+c nor keeps extra
 * precision. All work in double, also in a float build (which therefore is rounded once, at the end). Errors
 * in double, in units in the last place (u.l.p.): below 0.9 for exp, log, cbrt, sin and cos, below 2.1 for
 * the others. */

SB_INLINE uint64_t sbi_dense_bits(double x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}
SB_INLINE double sbi_dense_from_bits(uint64_t bits)
{
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}
/* 2^n for -1022 <= n <= 1023 */
SB_INLINE double sbi_dense_pow2(int n) { return sbi_dense_from_bits((uint64_t)(n + 1023) << 52); }
/* Exponent n of a positive normal x = 2^n m, 1 <= m < 2. */
SB_INLINE int sbi_dense_exponent(double x) { return (int)(sbi_dense_bits(x) >> 52) - 1023; }

SB_INLINE double sbi_dense_exp(double x)
{
    double hi, lo, r, p;
    int n, half;
    if (x != x)
        return x;
    if (x > 709.7827128933841)
        return (double)INFINITY;
    if (x < -745.1332191019412)
        return 0.0;
    /* x = n ln 2 + r, |r| <= 0.35; n times the 40-bit head of ln 2 is exact */
    n = (int)(x * 1.4426950408889634 + (x < 0 ? -0.5 : 0.5));
    hi = x - n * 0.6931471805592082;
    lo = n * 7.371002565167799e-13;
    r = hi - lo;
    p = 1.0 / 479001600.0 + r * (1.0 / 6227020800.0);
    p = 1.0 / 3628800.0 + r * (1.0 / 39916800.0 + r * p);
    p = 1.0 / 40320.0 + r * (1.0 / 362880.0 + r * p);
    p = 1.0 / 720.0 + r * (1.0 / 5040.0 + r * p);
    p = 1.0 / 24.0 + r * (1.0 / 120.0 + r * p);
    p = r * r * (0.5 + r * (1.0 / 6.0 + r * p));
    /* 2^n in two factors: both are normal, and a subnormal result is rounded once */
    half = n / 2;
    return (1.0 + (hi - (lo - p))) * sbi_dense_pow2(half) * sbi_dense_pow2(n - half);
}

SB_INLINE double sbi_dense_log(double x)
{
    double f, s, z, r, half_square;
    int n = 0;
    if (!(x > 0))
        return x == 0 ? -(double)INFINITY : (double)NAN;
    if (x > 1.7976931348623157e308)
        return x;
    if (x < 2.2250738585072014e-308) {
        x *= 18014398509481984.0; /* 2^54 makes a subnormal normal */
        n = -54;
    }
    n += sbi_dense_exponent(x);
    x = sbi_dense_from_bits((sbi_dense_bits(x) & 0x000fffffffffffffULL) | 0x3ff0000000000000ULL);
    if (x > 1.4142135623730951) {
        x *= 0.5;
        n++;
    }
    /* x = 1 + f, s = f / (2 + f): log x = 2 atanh s = f - (f^2/2 - s (f^2/2 + r)), r = 2 s^2/3 + 2 s^4/5 +
     * ... */
    f = x - 1.0;
    s = f / (2.0 + f);
    z = s * s;
    r = 2.0 / 19.0 + z * (2.0 / 21.0 + z * (2.0 / 23.0));
    r = 2.0 / 13.0 + z * (2.0 / 15.0 + z * (2.0 / 17.0 + z * r));
    r = 2.0 / 7.0 + z * (2.0 / 9.0 + z * (2.0 / 11.0 + z * r));
    r = z * (2.0 / 3.0 + z * (2.0 / 5.0 + z * r));
    half_square = 0.5 * f * f;
    return n * 0.6931471805592082 - ((half_square - (s * (half_square + r) + n * 7.371002565167799e-13)) - f);
}

/* For positive finite x = m 2^(3k), 1 <= m < 8: *m, *k, and cbrt(m) to 26 bits, whose square is exact. */
SB_INLINE double sbi_dense_cbrt_head(double x, double *m, int *k)
{
    double y, t, cube;
    int n = 0, rest;
    if (x < 2.2250738585072014e-308) {
        x *= 18014398509481984.0;
        n = -54;
    }
    n += sbi_dense_exponent(x);
    *k = (n + 1200) / 3 - 400; /* floor(n / 3) */
    rest = n - 3 * *k;
    y = sbi_dense_from_bits((sbi_dense_bits(x) & 0x000fffffffffffffULL) | 0x3ff0000000000000ULL);
    *m = rest == 0 ? y : rest == 1 ? 2.0 * y : 4.0 * y;
    t = 0.6256872265641462 + y * (0.43356059182365925 - y * 0.05836172077613474); /* to 9e-4 on [1, 2] */
    t *= rest == 0 ? 1.0 : rest == 1 ? 1.259921049894873 : 1.5874010519681994;
    cube = t * t * t;
    t *= (cube + 2.0 * *m) / (2.0 * cube + *m); /* Halley: to 5e-10 */
    return sbi_dense_from_bits((sbi_dense_bits(t) + 0x4000000ULL) & ~0x7ffffffULL);
}

SB_INLINE double sbi_dense_cbrt(double x)
{
    double m, t, ratio, size = fabs(x);
    int k;
    if (x == 0 || !(size <= 1.7976931348623157e308))
        return x; /* 0, infinity, NaN */
    t = sbi_dense_cbrt_head(size, &m, &k);
    ratio = m / (t * t);
    t += t * ((ratio - t) / (2.0 * t + ratio));
    t *= sbi_dense_pow2(k);
    return x < 0 ? -t : t;
}

SB_INLINE double sbi_dense_pow_minus_two_thirds(double x)
{
    double m, t, d;
    int k;
    if (!(x > 0))
        return x == 0 ? (double)INFINITY : (double)NAN;
    if (x > 1.7976931348623157e308)
        return 0.0;
    t = sbi_dense_cbrt_head(x, &m, &k);
    /* m = t^3 (1 + d): m^(-2/3) = t^-2 (1 - 2d/3 + 5d^2/9 ...), |d| < 3e-8 */
    d = (m / (t * t) - t) / t;
    return (1.0 - d * (2.0 / 3.0 - d * (5.0 / 9.0))) / (t * t) * sbi_dense_pow2(-2 * k);
}

SB_INLINE void sbi_dense_sin_cos(double x, double *s, double *c)
{
    double r, w, t, tail, y, low, z, p, half, sine, cosine;
    int n;
    if (!(fabs(x) <= 1.7976931348623157e308)) {
        *s = *c = (double)NAN;
        return;
    }
    if (fabs(x) > 1.0e6)
        x = fmod(x, 6.283185307179586); /* fmod is exact, so it is the same everywhere */
    /* x = n pi/2 + y + low; n times the two 33-bit heads of pi/2 is exact */
    n = (int)(x * 0.6366197723675814 + (x < 0 ? -0.5 : 0.5));
    t = x - n * 1.5707963267341256;
    w = n * 6.077100506303966e-11;
    r = t - w;
    tail = n * 2.0222662487959506e-21 - ((t - r) - w);
    y = r - tail;
    low = (r - y) - tail;
    z = y * y;
    p = -1.0 / 1307674368000.0 + z * (1.0 / 355687428096000.0);
    p = 1.0 / 362880.0 + z * (-1.0 / 39916800.0 + z * (1.0 / 6227020800.0 + z * p));
    p = -1.0 / 6.0 + z * (1.0 / 120.0 + z * (-1.0 / 5040.0 + z * p));
    sine = y + (y * z * p + low * (1.0 - 0.5 * z));
    p = -1.0 / 87178291200.0 + z * (1.0 / 20922789888000.0);
    p = -1.0 / 3628800.0 + z * (1.0 / 479001600.0 + z * p);
    p = 1.0 / 24.0 + z * (-1.0 / 720.0 + z * (1.0 / 40320.0 + z * p));
    half = 0.5 * z;
    w = 1.0 - half;
    cosine = w + (((1.0 - w) - half) + (z * z * p - y * low));
    *s = n & 1 ? cosine : sine;
    *c = n & 1 ? sine : cosine;
    if (n & 2)
        *s = -*s;
    if ((n + 1) & 2)
        *c = -*c;
}

/* atan(small / large), 0 <= small <= large, large > 0, both finite and of moderate size. */
SB_INLINE double sbi_dense_atan_octant(double small, double large)
{
    static const double table[9][2] = {/* atan(k / 8), and what its rounding left */
                                       {0.0, 0.0},
                                       {0.12435499454676144, -3.1253241424539383e-18},
                                       {0.24497866312686414, 1.0698755618734451e-17},
                                       {0.35877067027057225, -2.4623815582638635e-17},
                                       {0.4636476090008061, 2.2698777452961687e-17},
                                       {0.5585993153435624, -5.4556305485916264e-18},
                                       {0.6435011087932844, 1.5834785051444286e-17},
                                       {0.7188299996216245, -2.1478388444456983e-17},
                                       {0.7853981633974483, 3.061616997868383e-17}};
    int k = (int)(8.0 * (small / large) + 0.5);
    double c = 0.125 * k; /* atan(y/x) = atan(c) + atan((y - c x)/(x + c y)); the last argument is <= 1/16 */
    double u = (small - c * large) / (large + c * small), z = u * u, p;
    p = 1.0 / 9.0 + z * (-1.0 / 11.0 + z * (1.0 / 13.0 - z * (1.0 / 15.0)));
    p = -1.0 / 3.0 + z * (1.0 / 5.0 + z * (-1.0 / 7.0 + z * p));
    return table[k][0] + (u + (u * z * p + table[k][1]));
}

SB_INLINE double sbi_dense_atan2(double y, double x)
{
    double small = fabs(y), large = fabs(x), angle, scale;
    int steep = small > large;
    if (x != x || y != y)
        return (double)NAN;
    if (steep) {
        double swap = small;
        small = large;
        large = swap;
    }
    if (large == 0) {
        angle = 0.0;
    } else if (large > 1.7976931348623157e308) {
        angle = small > 1.7976931348623157e308 ? 0.7853981633974483 : 0.0;
    } else {
        scale = large > 1.0e150 ? sbi_dense_pow2(-600) : large < 1.0e-150 ? sbi_dense_pow2(600) : 1.0;
        small *= scale;
        large *= scale;
        angle = sbi_dense_atan_octant(small, large);
    }
    /* pi and pi/2 in two parts */
    if (steep)
        angle = 1.5707963267948966 - (angle - 6.123233995736766e-17);
    if (copysign(1.0, x) < 0)
        angle = 3.141592653589793 - (angle - 1.2246467991473532e-16);
    return copysign(angle, y);
}

/* e^x. Above 709.78 (float: 88.72) infinity, below -745.1 (-103.9) 0, subnormal results in between; NaN for
 * NaN. */
SB_INLINE sb_real sb_exp(sb_real x) { return (sb_real)sbi_dense_exp((double)x); }
/* Natural logarithm. -infinity for 0, NaN for x < 0 and for NaN. */
SB_INLINE sb_real sb_log(sb_real x) { return (sb_real)sbi_dense_log((double)x); }
/* Cube root, for every finite x; odd; infinity, NaN and the sign of 0 pass through. Exact for exact cubes. */
SB_INLINE sb_real sb_cbrt(sb_real x) { return (sb_real)sbi_dense_cbrt((double)x); }
/* x^(-2/3), the isochoric scale J^(-2/3) of a volume ratio x > 0. Infinity for 0; NaN for x < 0 and NaN. */
SB_INLINE sb_real sb_pow_minus_two_thirds(sb_real x)
{
    return (sb_real)sbi_dense_pow_minus_two_thirds((double)x);
}
/* Sine and cosine of x [rad]. Above 1e6 rad they are those of an x changed by less than half its own u.l.p.
 * (2 pi is rounded there). NaN for NaN and infinity. */
SB_INLINE void sb_sin_cos(sb_real x, sb_real *s, sb_real *c)
{
    double sine, cosine;
    sbi_dense_sin_cos((double)x, &sine, &cosine);
    *s = (sb_real)sine;
    *c = (sb_real)cosine;
}
/* Angle of the point (x, y), in [-pi, pi], with atan2's signs; 0 or pi for the origin, after the signs of the
 * zeros; NaN for NaN. */
SB_INLINE sb_real sb_atan2(sb_real y, sb_real x) { return (sb_real)sbi_dense_atan2((double)y, (double)x); }
/* Angle in [0, pi] whose cosine is x; NaN outside [-1, 1]. */
SB_INLINE sb_real sb_acos(sb_real x)
{
    double c = (double)x;
    return (sb_real)sbi_dense_atan2(sqrt((1.0 - c) * (1.0 + c)), c);
}

/* ---- quaternions of rotations ---- */

SB_INLINE sb_quat sb_quat_make(sb_real w, sb_real x, sb_real y, sb_real z)
{
    sb_quat q;
    q.w = w;
    q.x = x;
    q.y = y;
    q.z = z;
    return q;
}
SB_INLINE sb_quat sb_quat_identity(void) { return sb_quat_make(1, 0, 0, 0); }
/* The inverse rotation of a unit q. */
SB_INLINE sb_quat sb_quat_conjugate(sb_quat q) { return sb_quat_make(q.w, -q.x, -q.y, -q.z); }
SB_INLINE sb_real sb_quat_dot(sb_quat a, sb_quat b) { return a.w * b.w + a.x * b.x + a.y * b.y + a.z * b.z; }
/* a b: the rotation b followed by the rotation a. The order of the products avoids - and + in turn from
 * entry to entry: there gcc 12 fuses multiply and add even under -ffp-contract=off (its vfmaddsub). */
SB_INLINE sb_quat sb_quat_mul(sb_quat a, sb_quat b)
{
    sb_quat r;
    r.w = a.w * b.w - (a.x * b.x + a.y * b.y + a.z * b.z);
    r.x = a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y;
    r.y = a.w * b.y + a.y * b.w + a.z * b.x - a.x * b.z;
    r.z = a.w * b.z + a.z * b.w + a.x * b.y - a.y * b.x;
    return r;
}
/* q / |q|; the identity when q is zero or not finite. */
SB_INLINE sb_quat sb_quat_normalise(sb_quat q)
{
    sb_real size = sb_max(sb_max(sb_abs(q.w), sb_abs(q.x)), sb_max(sb_abs(q.y), sb_abs(q.z))), n, scale;
    if (!(size > 0))
        return sb_quat_identity();
    q = sb_quat_make(q.w / size, q.x / size, q.y / size, q.z / size); /* squares stay in range */
    n = sb_quat_dot(q, q);
    if (!(n > 0)) /* an entry was NaN or infinite */
        return sb_quat_identity();
    scale = (sb_real)1 / sb_sqrt(n);
    return sb_quat_make(scale * q.w, scale * q.x, scale * q.y, scale * q.z);
}
/* Rotation by |v| rad about v (the exponential map); the identity for v = 0. */
SB_INLINE sb_quat sb_quat_from_rotation_vector(sb_vec3 v)
{
    sb_real angle = sb_v3_norm(v), s, c, factor;
    sb_sin_cos((sb_real)0.5 * angle, &s, &c);
    factor = angle > 0 ? s / angle : (sb_real)0.5;
    return sb_quat_make(c, factor * v.x, factor * v.y, factor * v.z);
}
/* |q|^2 times the rotation matrix of q: no division, and exact zeros stay zeros. */
SBI_FORCE_INLINE sb_mat3 sbi_quat_to_scaled_mat3(sb_quat q)
{
    sb_real ww = q.w * q.w, xx = q.x * q.x, yy = q.y * q.y, zz = q.z * q.z;
    sb_real xy = q.x * q.y, xz = q.x * q.z, yz = q.y * q.z, wx = q.w * q.x, wy = q.w * q.y, wz = q.w * q.z;
    sb_real sum = ww + xx, difference = ww - xx;
    sb_mat3 r;
    xy += xy, xz += xz, yz += yz, wx += wx, wy += wy, wz += wz; /* exact: fused or not is the same */
    r.m[0][0] = sum - (yy + zz), r.m[0][1] = xy - wz, r.m[0][2] = xz + wy;
    r.m[1][0] = xy + wz, r.m[1][1] = difference + (yy - zz), r.m[1][2] = yz - wx;
    r.m[2][0] = xz - wy, r.m[2][1] = yz + wx, r.m[2][2] = difference + (zz - yy);
    return r;
}
/* Rotation matrix of a unit quaternion. */
SB_INLINE sb_mat3 sb_quat_to_mat3(sb_quat q) { return sbi_quat_to_scaled_mat3(q); }
/* Unit quaternion, w >= 0, of a rotation matrix (Shepperd 1978: the largest component first, so no
 * cancellation). */
SB_INLINE sb_quat sb_quat_from_mat3(sb_mat3 r)
{
    sb_real trace = sb_m3_trace(r);
    sb_quat q;
    if (trace >= r.m[0][0] && trace >= r.m[1][1] && trace >= r.m[2][2])
        q = sb_quat_make(1 + trace, r.m[2][1] - r.m[1][2], r.m[0][2] - r.m[2][0], r.m[1][0] - r.m[0][1]);
    else if (r.m[0][0] >= r.m[1][1] && r.m[0][0] >= r.m[2][2])
        q = sb_quat_make(r.m[2][1] - r.m[1][2], 1 + r.m[0][0] - r.m[1][1] - r.m[2][2], r.m[0][1] + r.m[1][0],
                         r.m[0][2] + r.m[2][0]);
    else if (r.m[1][1] >= r.m[2][2])
        q = sb_quat_make(r.m[0][2] - r.m[2][0], r.m[0][1] + r.m[1][0], 1 + r.m[1][1] - r.m[0][0] - r.m[2][2],
                         r.m[1][2] + r.m[2][1]);
    else
        q = sb_quat_make(r.m[1][0] - r.m[0][1], r.m[0][2] + r.m[2][0], r.m[1][2] + r.m[2][1],
                         1 + r.m[2][2] - r.m[0][0] - r.m[1][1]);
    q = sb_quat_normalise(q);
    return q.w < 0 ? sb_quat_make(-q.w, -q.x, -q.y, -q.z) : q;
}
/* v rotated by the unit quaternion q. */
SB_INLINE sb_vec3 sb_quat_rotate(sb_quat q, sb_vec3 v)
{
    sb_vec3 u = sb_v3(q.x, q.y, q.z), t = sb_v3_cross(u, v);
    t = sb_v3_add(t, t);
    return sb_v3_add(sb_v3_madd(v, q.w, t), sb_v3_cross(u, t));
}

/* ---- symmetric eigenvalues, singular values ---- */

/* Largest |entry|, or NaN when an entry is not finite. */
SB_INLINE sb_real sbi_dense_max_abs(const sb_real *a, int count)
{
    sb_real largest = 0, zero = 0;
    for (int i = 0; i < count; i++) {
        largest = sb_max(sb_abs(a[i]), largest);
        zero += a[i] - a[i];
    }
    return largest + zero;
}

/* Power of two s for which s * size is near 1, and 1 / s, both exact. */
SB_INLINE void sbi_dense_scale(sb_real size, sb_real *scale, sb_real *inverse)
{
    int n = (double)size < 2.2250738585072014e-308 ? -1022 : sbi_dense_exponent((double)size);
    int limit = SB_REAL_IS_FLOAT ? 120 : 1020;
    n = n > limit ? limit : n < -limit ? -limit : n;
    *scale = (sb_real)sbi_dense_pow2(-n);
    *inverse = (sb_real)sbi_dense_pow2(n);
}

/* Tangent of the angle of the Jacobi rotation that makes [[a, b], [b, d]] diagonal, b != 0, |angle| <= 45
 * deg. */
SB_INLINE sb_real sbi_dense_jacobi_tangent(sb_real a, sb_real b, sb_real d)
{
    sb_real theta = (d - a) / (b + b);
    sb_real t = (sb_real)1 / (sb_abs(theta) + sb_sqrt(theta * theta + 1)); /* 0 when theta^2 overflows */
    return theta < 0 ? -t : t;
}

/* Is the off-diagonal g of a 2x2 block with the diagonal a, d large enough to rotate away? Relative to the
 * diagonal, so that graded matrices keep their small eigenvalues; entries are scaled to 1. */
SB_INLINE int sbi_dense_jacobi_needed(sb_real a, sb_real g, sb_real d)
{
    const sb_real least = SB_EPSILON * SB_EPSILON * SB_EPSILON;
    g = sb_abs(g);
    return g > least && g > (sb_real)0.25 * SB_EPSILON * sb_sqrt(sb_abs(a)) * sb_sqrt(sb_abs(d));
}

/* Cyclic Jacobi on the n x n symmetric a (entries up to about 1): eigenvalues on its diagonal, eigenvectors
 * in the columns of v. At most 20 sweeps (4 to 6 are usual). */
SBI_FORCE_INLINE void sbi_dense_jacobi(sb_real *a, sb_real *v, int n)
{
    for (int i = 0; i < n * n; i++)
        v[i] = i % (n + 1) == 0 ? (sb_real)1 : (sb_real)0;
    for (int sweep = 0, rotated = 1; rotated && sweep < 20; sweep++) {
        rotated = 0;
        for (int p = 0; p < n - 1; p++)
            for (int q = p + 1; q < n; q++) {
                sb_real g = a[p * n + q], t, c, s;
                if (!sbi_dense_jacobi_needed(a[p * n + p], g, a[q * n + q]))
                    continue;
                rotated = 1;
                t = sbi_dense_jacobi_tangent(a[p * n + p], g, a[q * n + q]);
                c = (sb_real)1 / sb_sqrt(t * t + 1);
                s = t * c;
                a[p * n + p] -= t * g;
                a[q * n + q] += t * g;
                a[p * n + q] = a[q * n + p] = 0;
                for (int k = 0; k < n; k++) {
                    sb_real vp = v[k * n + p], vq = v[k * n + q];
                    v[k * n + p] = c * vp - s * vq;
                    v[k * n + q] = s * vp + c * vq;
                    if (k != p && k != q) {
                        sb_real ap = a[k * n + p], aq = a[k * n + q];
                        a[k * n + p] = a[p * n + k] = c * ap - s * aq;
                        a[k * n + q] = a[q * n + k] = s * ap + c * aq;
                    }
                }
            }
    }
}

/* Eigenvalues, descending (x >= y >= z), and orthonormal eigenvectors of a symmetric a: a = V diag(values)
 * V^T, det V = +1, column j of *vectors belongs to value j. Reads the upper triangle of a. Errors are a few
 * u.l.p. of the largest |value|. For a not finite: values NaN, vectors the identity. Either output may be
 * NULL. */
SB_INLINE void sb_m3_eigen(sb_mat3 a, sb_vec3 *values, sb_mat3 *vectors)
{
    sb_real m[9], v[9], d[3], scale, inverse, size;
    int order[3] = {0, 1, 2};
    sb_mat3 basis = sb_m3_identity();
    for (int i = 0; i < 9; i++)
        m[i] = i / 3 <= i % 3 ? a.m[i / 3][i % 3] : a.m[i % 3][i / 3];
    size = sbi_dense_max_abs(m, 9);
    if (!(size > 0)) { /* zero or NaN: size itself is the answer */
        if (values)
            *values = sb_v3(size, size, size);
        if (vectors)
            *vectors = basis;
        return;
    }
    sbi_dense_scale(size, &scale, &inverse);
    for (int i = 0; i < 9; i++)
        m[i] *= scale;
    sbi_dense_jacobi(m, v, 3);
    for (int i = 0; i < 3; i++)
        d[i] = m[4 * i];
    for (int pass = 0; pass < 3; pass++) {
        int i = pass % 2;
        if (d[order[i]] < d[order[i + 1]]) {
            int swap = order[i];
            order[i] = order[i + 1];
            order[i + 1] = swap;
        }
    }
    for (int j = 0; j < 3; j++)
        for (int i = 0; i < 3; i++)
            basis.m[i][j] = v[3 * i + order[j]];
    if (sb_m3_det(basis) < 0)
        for (int i = 0; i < 3; i++)
            basis.m[i][2] = -basis.m[i][2];
    if (values)
        *values = sb_v3(d[order[0]] * inverse, d[order[1]] * inverse, d[order[2]] * inverse);
    if (vectors)
        *vectors = basis;
}

/* A unit vector at right angles to the unit vector a. */
SB_INLINE sb_vec3 sb_v3_perpendicular(sb_vec3 a)
{
    sb_vec3 axis = sb_abs(a.x) < (sb_real)0.6 ? sb_v3(1, 0, 0) : sb_v3(0, 1, 0), b = sb_v3_cross(a, axis);
    return sb_v3_scale((sb_real)1 / sb_v3_norm(b), b);
}

/* One-sided Jacobi (Hestenes): turns pairs of columns of b and v until the columns of b are at right angles,
 * each pair to rounding relative to its own lengths. At most 20 sweeps. */
SB_INLINE void sbi_dense_orthogonalise(sb_vec3 b[3], sb_vec3 v[3])
{
    for (int sweep = 0, rotated = 1; rotated && sweep < 20; sweep++) {
        rotated = 0;
        for (int p = 0; p < 2; p++)
            for (int q = p + 1; q < 3; q++) {
                sb_real alpha = sb_v3_dot(b[p], b[p]), gamma = sb_v3_dot(b[p], b[q]),
                        beta = sb_v3_dot(b[q], b[q]);
                sb_vec3 bp = b[p], vp = v[p];
                sb_real t, c, s;
                if (!(sb_abs(gamma) > SB_EPSILON * sb_sqrt(alpha) * sb_sqrt(beta)))
                    continue;
                rotated = 1;
                t = sbi_dense_jacobi_tangent(alpha, gamma, beta);
                c = (sb_real)1 / sb_sqrt(t * t + 1);
                s = t * c;
                b[p] = sb_v3_madd(sb_v3_scale(c, bp), -s, b[q]);
                b[q] = sb_v3_madd(sb_v3_scale(s, bp), c, b[q]);
                v[p] = sb_v3_madd(sb_v3_scale(c, vp), -s, v[q]);
                v[q] = sb_v3_madd(sb_v3_scale(s, vp), c, v[q]);
            }
    }
}

/* Left singular vectors from the orthogonal columns b (lengths n, descending): orthonormal, det +1, also
 * where a length is 0 or so small that its direction is noise. */
SB_INLINE sb_mat3 sbi_dense_left_vectors(const sb_vec3 b[3], const sb_real n[3])
{
    sb_vec3 u0 = sb_v3(1, 0, 0), u1 = u0;
    sb_real left = 0;
    if (n[0] > 0)
        u0 = sb_v3_scale((sb_real)1 / n[0], b[0]);
    u0 = sb_v3_scale((sb_real)1 / sb_v3_norm(u0), u0);
    if (n[1] > 0) {
        u1 = sb_v3_scale((sb_real)1 / n[1], b[1]);
        u1 = sb_v3_madd(u1, -sb_v3_dot(u0, u1), u0);
        left = sb_v3_norm(u1);
    }
    u1 = left > (sb_real)0.5 ? sb_v3_scale((sb_real)1 / left, u1) : sb_v3_perpendicular(u0);
    return sb_m3_columns(u0, u1, sb_v3_cross(u0, u1));
}

/* Length of a vector whose entries may be so small that their squares vanish. */
SB_INLINE sb_real sbi_dense_safe_norm(sb_vec3 a)
{
    sb_real size = sb_max(sb_abs(a.x), sb_max(sb_abs(a.y), sb_abs(a.z)));
    return size > 0 ? size * sb_v3_norm(sb_v3(a.x / size, a.y / size, a.z / size)) : 0;
}

/* Singular values with signs: f = U diag(s) V^T, det U = det V = +1, s.x >= s.y >= |s.z|, and s.z has the
 * sign of det f (Irving, Teran, Fedkiw 2004). Works for every rank, repeated values and every scale; small
 * singular values keep their relative accuracy as far as the columns of f allow. For f not finite: s NaN, U =
 * V = identity. One-sided Jacobi, no f^T f. Outputs may be NULL. */
SB_INLINE void sb_m3_svd(sb_mat3 f, sb_mat3 *u, sb_vec3 *s, sb_mat3 *v)
{
    sb_mat3 left = sb_m3_identity(), right = left;
    sb_real size = sbi_dense_max_abs(&f.m[0][0], 9), scale, inverse;
    sb_vec3 value = sb_v3(size, size, size);
    if (size > 0) {
        sb_vec3 b[3], w[3];
        sb_real n[3];
        sbi_dense_scale(size, &scale, &inverse);
        for (int j = 0; j < 3; j++) {
            b[j] = sb_v3_scale(scale, sb_m3_column(f, j));
            w[j] = sb_m3_column(right, j);
        }
        sbi_dense_orthogonalise(b, w);
        for (int j = 0; j < 3; j++)
            n[j] = sbi_dense_safe_norm(b[j]);
        for (int pass = 0; pass < 3; pass++) {
            int i = pass % 2;
            if (n[i] < n[i + 1]) { /* a swap with one sign change keeps det V = +1 */
                sb_vec3 swap = b[i];
                sb_real length = n[i];
                b[i] = b[i + 1], n[i] = n[i + 1];
                b[i + 1] = sb_v3_scale(-1, swap), n[i + 1] = length;
                swap = w[i];
                w[i] = w[i + 1];
                w[i + 1] = sb_v3_scale(-1, swap);
            }
        }
        left = sbi_dense_left_vectors(b, n);
        right = sb_m3_columns(w[0], w[1], w[2]);
        if (sb_v3_dot(sb_m3_column(left, 2), b[2]) < 0)
            n[2] = -n[2];
        value = sb_v3(n[0] * inverse, n[1] * inverse, n[2] * inverse);
    }
    if (u)
        *u = left;
    if (s)
        *s = value;
    if (v)
        *v = right;
}

/* ---- rotation of a deformation gradient ------------------------------------------------------------------
 * The rotation R that maximises tr(R^T F): the polar rotation for det F > 0 and its continuation with det R =
 * +1 for inverted F. With B = R^T F at the present R, a = (B21-B12, B02-B20, B10-B01) and H = tr(B) I -
 * sym(B), the quaternion (1, u) that turns R into the maximiser solves the eigenproblem (2H + (a.u) I) u = a.
 * Its first approximation u = H^-1 a / 2 is Newton's step; putting a.u back costs a fraction of a step and
 * gains two orders each time. H is positive definite only near the maximum, and no other stationary rotation
 * has such an H. (Compare Kugelstadt, Koschier, Bender 2018, who take the Newton step alone.) */

#define SBI_POLAR_STEPS 4 /* steps before a matrix counts as hard */
#if SB_REAL_IS_FLOAT
#define SBI_POLAR_LAST 8e-13f      /* square of a last correction that leaves an error below rounding */
#define SBI_POLAR_DEFINITE 3.5e-4f /* least det H / (tr H)^3 a Newton step is taken at: sqrt(SB_EPSILON) */
#define SBI_POLAR_LEAST 1e-9f      /* tr H outside these bounds: F must be scaled first, for det H's sake */
#define SBI_POLAR_MOST 1e9f
#else
#define SBI_POLAR_LAST 9e-26
#define SBI_POLAR_DEFINITE 1.5e-8
#define SBI_POLAR_LEAST 1e-60
#define SBI_POLAR_MOST 1e60
#endif

/* The next approximation of u after x: x0 - (a.x) (2H)^-1 x, with x0 = (2H)^-1 a and (2H)^-1 = inverse c. */
SBI_FORCE_INLINE sb_vec3 sbi_polar_correct(sb_vec3 x, sb_vec3 x0, sb_vec3 a, sb_mat3 c, sb_real inverse)
{
    return sb_v3_madd(x0, -(sb_v3_dot(a, x) * inverse), sb_m3_apply(c, x));
}

/* Step at q: *u, and *last = the square of its last correction. Returns 1, or 0 when H is not safely positive
 * definite, u is too long for its series, or F is out of range or not finite (then *u means nothing). |q|
 * need not be exactly 1: u does not depend on it. No branches and no loops, so that lanes of it vectorise. */
SBI_FORCE_INLINE int sbi_polar_newton(sb_mat3 f, sb_quat q, sb_vec3 *u, sb_real *last)
{
    sb_mat3 r = sbi_quat_to_scaled_mat3(q);
    sb_real b00 = r.m[0][0] * f.m[0][0] + r.m[1][0] * f.m[1][0] + r.m[2][0] * f.m[2][0];
    sb_real b01 = r.m[0][0] * f.m[0][1] + r.m[1][0] * f.m[1][1] + r.m[2][0] * f.m[2][1];
    sb_real b02 = r.m[0][0] * f.m[0][2] + r.m[1][0] * f.m[1][2] + r.m[2][0] * f.m[2][2];
    sb_real b10 = r.m[0][1] * f.m[0][0] + r.m[1][1] * f.m[1][0] + r.m[2][1] * f.m[2][0];
    sb_real b11 = r.m[0][1] * f.m[0][1] + r.m[1][1] * f.m[1][1] + r.m[2][1] * f.m[2][1];
    sb_real b12 = r.m[0][1] * f.m[0][2] + r.m[1][1] * f.m[1][2] + r.m[2][1] * f.m[2][2];
    sb_real b20 = r.m[0][2] * f.m[0][0] + r.m[1][2] * f.m[1][0] + r.m[2][2] * f.m[2][0];
    sb_real b21 = r.m[0][2] * f.m[0][1] + r.m[1][2] * f.m[1][1] + r.m[2][2] * f.m[2][1];
    sb_real b22 = r.m[0][2] * f.m[0][2] + r.m[1][2] * f.m[1][2] + r.m[2][2] * f.m[2][2];
    sb_real ax = b21 - b12, ay = b02 - b20, az = b10 - b01;
    /* g = 2H and its adjugate c */
    sb_real g00 = (b11 + b22) + (b11 + b22), g11 = (b00 + b22) + (b00 + b22), g22 = (b00 + b11) + (b00 + b11);
    sb_real g01 = -(b01 + b10), g02 = -(b02 + b20), g12 = -(b12 + b21);
    sb_real c00 = g11 * g22 - g12 * g12, c01 = g12 * g02 - g01 * g22, c02 = g01 * g12 - g11 * g02;
    sb_real c11 = g00 * g22 - g02 * g02, c12 = g01 * g02 - g00 * g12, c22 = g00 * g11 - g01 * g01;
    sb_real det = g00 * c00 + g01 * c01 + g02 * c02, trace = g00 + g11 + g22, inverse = (sb_real)1 / det;
    sb_mat3 c = sb_m3_columns(sb_v3(c00, c01, c02), sb_v3(c01, c11, c12), sb_v3(c02, c12, c22));
    sb_vec3 a = sb_v3(ax, ay, az), first = sb_v3_scale(inverse, sb_m3_apply(c, a)), before, change;
    before = sbi_polar_correct(first, first, a, c, inverse);
    before = sbi_polar_correct(before, first, a, c, inverse);
    *u = sbi_polar_correct(before, first, a, c, inverse);
    change = sb_v3_sub(*u, before);
    *last = sb_v3_dot(change, change);
    return (det > SBI_POLAR_DEFINITE * (trace * trace * trace)) & (g00 > 0) & (c22 > 0) &
           (trace > SBI_POLAR_LEAST) & (trace < SBI_POLAR_MOST) & (sb_v3_dot(first, first) < (sb_real)0.25);
}

/* q (1, u) for |u| <= 0.6: the rotation q and then the step. The length stays within a few per cent of |q|
 * and is put right at the end. */
SBI_FORCE_INLINE sb_quat sbi_polar_turn(sb_quat q, sb_vec3 u)
{
    sb_real n = u.x * u.x + u.y * u.y + u.z * u.z;
    sb_real scale = 1 - n * ((sb_real)0.5 - (sb_real)0.375 * n); /* near 1 / |(1, u)| */
    return sb_quat_mul(q, sb_quat_make(scale, scale * u.x, scale * u.y, scale * u.z));
}

/* The maximiser nearest to `start` from the 4x4 eigenproblem tr(R(q)^T F) = q^T K q (Davenport): always
 * works, F scaled to about 1. Eigenvectors whose values agree to rounding are one space: there R is not
 * unique. */
SB_INLINE sb_quat sbi_polar_davenport(sb_mat3 f, sb_quat start)
{
    sb_real k[16], v[16], best, tie, along, q[4] = {0, 0, 0, 0}, s[4];
    int top = 0;
    k[0] = f.m[0][0] + f.m[1][1] + f.m[2][2];
    k[5] = f.m[0][0] - f.m[1][1] - f.m[2][2];
    k[10] = f.m[1][1] - f.m[0][0] - f.m[2][2];
    k[15] = f.m[2][2] - f.m[0][0] - f.m[1][1];
    k[1] = k[4] = f.m[2][1] - f.m[1][2];
    k[2] = k[8] = f.m[0][2] - f.m[2][0];
    k[3] = k[12] = f.m[1][0] - f.m[0][1];
    k[6] = k[9] = f.m[0][1] + f.m[1][0];
    k[7] = k[13] = f.m[0][2] + f.m[2][0];
    k[11] = k[14] = f.m[1][2] + f.m[2][1];
    tie = 16 * SB_EPSILON * sbi_dense_max_abs(k, 16);
    sbi_dense_jacobi(k, v, 4);
    for (int j = 1; j < 4; j++)
        top = k[5 * j] > k[5 * top] ? j : top;
    best = k[5 * top];
    s[0] = start.w, s[1] = start.x, s[2] = start.y, s[3] = start.z;
    for (int j = 0; j < 4; j++)
        if (k[5 * j] >= best - tie) {
            along = s[0] * v[j] + s[1] * v[4 + j] + s[2] * v[8 + j] + s[3] * v[12 + j];
            for (int i = 0; i < 4; i++)
                q[i] += along * v[4 * i + j];
        }
    if (!(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3] > SB_EPSILON))
        for (int i = 0; i < 4; i++) /* start is at right angles to every maximiser: any of them will do */
            q[i] = v[4 * i + top];
    return sb_quat_normalise(sb_quat_make(q[0], q[1], q[2], q[3]));
}

/* The general case: any scale, any start. Newton where H allows it, else the step of Mueller et al. 2016;
 * after that, or where H is singular at the maximum itself, the eigenproblem. */
SB_INLINE sb_quat sbi_polar_hard(sb_mat3 f, sb_quat start)
{
    sb_real size = sbi_dense_max_abs(&f.m[0][0], 9), scale, inverse;
    sb_quat q = start;
    if (!(size > 0))
        return start;
    sbi_dense_scale(size, &scale, &inverse);
    f = sb_m3_scale(scale, f);
    for (int step = 0, rough = 0; step < 12 && rough < 4; step++) {
        sb_vec3 w;
        sb_real last, w2;
        int newton = sbi_polar_newton(f, q, &w, &last);
        if (newton) {
            q = sb_quat_normalise(sbi_polar_turn(q, w));
            if (last < SBI_POLAR_LAST)
                return q;
        } else {
            sb_mat3 b = sb_m3_tmul(sb_quat_to_mat3(q), f);
            sb_real trace = sb_abs(sb_m3_trace(b)) + (sb_real)0.01;
            w = sb_v3((b.m[2][1] - b.m[1][2]) / trace, (b.m[0][2] - b.m[2][0]) / trace,
                      (b.m[1][0] - b.m[0][1]) / trace);
            w2 = sb_v3_dot(w, w);
            if (w2 < (sb_real)1e-4)
                break; /* a stationary point or nearly so: Newton will not take over soon */
            q = sb_quat_normalise(sb_quat_mul(q, sb_quat_make(1 + sb_sqrt(1 + w2), w.x, w.y, w.z)));
            rough++;
        }
    }
    return sbi_polar_davenport(f, start);
}

/* Unit quaternion of the rotation R that maximises tr(R^T f); R = sb_quat_to_mat3(result), S = R^T f. f: any
 * finite matrix, also inverted or singular; where the maximiser is not unique, one near `start`. start: unit
 * quaternion, best the result of the last step (the sign of the result follows it). Zero or non-finite f:
 * start. Errors: a few u.l.p. times |f| / (s_y + s_z), the distance from the nearest f whose R is not unique.
 * One step from 1 deg, two from 30. */
SB_INLINE sb_quat sb_m3_polar(sb_mat3 f, sb_quat start)
{
    sb_real n = sb_quat_dot(start, start), last, scale;
    sb_quat q;
    if (!(sb_abs(n - 1) < (sb_real)0.01))
        start = sb_quat_normalise(start);
    q = start;
    for (int step = 0; step < SBI_POLAR_STEPS; step++) {
        sb_vec3 u;
        if (!sbi_polar_newton(f, q, &u, &last))
            break;
        q = sbi_polar_turn(q, u);
        if (last < SBI_POLAR_LAST) {
            scale = (sb_real)1 / sb_sqrt(sb_quat_dot(q, q));
            return sb_quat_make(scale * q.w, scale * q.x, scale * q.y, scale * q.z);
        }
    }
    return sbi_polar_hard(f, start);
}
/* The same without a guess. */
SB_INLINE sb_quat sb_m3_polar_cold(sb_mat3 f) { return sb_m3_polar(f, sb_quat_identity()); }

/* sb_m3_polar for SB_POLAR_LANES matrices at once, written so that compilers turn the lanes into vector
 * instructions (-O3, or gcc 12's -O2; best with -march=native). */
#define SB_POLAR_LANES 8

/* What a batch works on. Flags are 0 or 1; as sb_real, and combined by arithmetic, because compilers turn
 * chains of conditions back into branches, which do not vectorise. */
typedef struct sbi_polar_lanes {
    sb_real start[4][SB_POLAR_LANES], q[4][SB_POLAR_LANES], next[4][SB_POLAR_LANES];
    sb_real moving[SB_POLAR_LANES]; /* not yet converged */
    sb_real hard[SB_POLAR_LANES];   /* left to the scalar function */
    sb_real good[SB_POLAR_LANES], last[SB_POLAR_LANES];
} sbi_polar_lanes;

/* One step in each moving lane. Lanes never look at each other. Two loops, so that no arithmetic can sink
 * into the selection. */
SBI_FORCE_INLINE void sbi_polar_batch_step(sb_real (*SB_RESTRICT f)[SB_POLAR_LANES],
                                           sbi_polar_lanes *SB_RESTRICT s)
{
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_quat q = sb_quat_make(s->q[0][l], s->q[1][l], s->q[2][l], s->q[3][l]);
        sb_mat3 a;
        sb_vec3 u;
        a.m[0][0] = f[0][l], a.m[0][1] = f[1][l], a.m[0][2] = f[2][l];
        a.m[1][0] = f[3][l], a.m[1][1] = f[4][l], a.m[1][2] = f[5][l];
        a.m[2][0] = f[6][l], a.m[2][1] = f[7][l], a.m[2][2] = f[8][l];
        s->good[l] = sbi_polar_newton(a, q, &u, &s->last[l]) ? (sb_real)1 : (sb_real)0;
        q = sbi_polar_turn(q, u);
        s->next[0][l] = q.w, s->next[1][l] = q.x, s->next[2][l] = q.y, s->next[3][l] = q.z;
    }
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_real was = s->moving[l], go = was * s->good[l];
        s->q[0][l] = go > 0 ? s->next[0][l] : s->q[0][l];
        s->q[1][l] = go > 0 ? s->next[1][l] : s->q[1][l];
        s->q[2][l] = go > 0 ? s->next[2][l] : s->q[2][l];
        s->q[3][l] = go > 0 ? s->next[3][l] : s->q[3][l];
        s->moving[l] = s->last[l] >= SBI_POLAR_LAST ? go : 0;
        s->hard[l] += was - go;
    }
}

SBI_FORCE_INLINE int sbi_polar_any(const sb_real *flags)
{
    sb_real sum =
        ((flags[0] + flags[1]) + (flags[2] + flags[3])) + ((flags[4] + flags[5]) + (flags[6] + flags[7]));
    return sum > 0;
}

/* Writes the quaternions, normalised (|q|^2 within 0.95 ... 1.05: Newton for 1 / sqrt, which unlike sqrt
 * always vectorises), and the rotation matrices. */
SBI_FORCE_INLINE void sbi_polar_batch_finish(const sbi_polar_lanes *SB_RESTRICT s,
                                             sb_real (*SB_RESTRICT q)[SB_POLAR_LANES],
                                             sb_real (*SB_RESTRICT r)[SB_POLAR_LANES])
{
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_quat a = sb_quat_make(s->q[0][l], s->q[1][l], s->q[2][l], s->q[3][l]);
        sb_real n = sb_quat_dot(a, a), half = (sb_real)0.5 * n;
        sb_real y = (sb_real)1.875 - n * ((sb_real)1.25 - (sb_real)0.375 * n);
        sb_mat3 m;
        y = y * ((sb_real)1.5 - half * (y * y));
        y = y * ((sb_real)1.5 - half * (y * y));
        a = sb_quat_make(y * a.w, y * a.x, y * a.y, y * a.z);
        m = sbi_quat_to_scaled_mat3(a);
        q[0][l] = a.w, q[1][l] = a.x, q[2][l] = a.y, q[3][l] = a.z;
        r[0][l] = m.m[0][0], r[1][l] = m.m[0][1], r[2][l] = m.m[0][2];
        r[3][l] = m.m[1][0], r[4][l] = m.m[1][1], r[5][l] = m.m[1][2];
        r[6][l] = m.m[2][0], r[7][l] = m.m[2][1], r[8][l] = m.m[2][2];
    }
}

/* One lane by the scalar function. */
SB_INLINE void sbi_polar_lane(sb_real (*f)[SB_POLAR_LANES], sb_real (*start)[SB_POLAR_LANES],
                              sb_real (*q)[SB_POLAR_LANES], sb_real (*r)[SB_POLAR_LANES], int l)
{
    sb_mat3 a, m;
    sb_quat p;
    for (int i = 0; i < 9; i++)
        a.m[i / 3][i % 3] = f[i][l];
    p = sb_m3_polar(a, sb_quat_make(start[0][l], start[1][l], start[2][l], start[3][l]));
    m = sb_quat_to_mat3(p);
    q[0][l] = p.w, q[1][l] = p.x, q[2][l] = p.y, q[3][l] = p.z;
    for (int i = 0; i < 9; i++)
        r[i][l] = m.m[i / 3][i % 3];
}

/* Rotations of SB_POLAR_LANES matrices. f[3 i + j][lane] = F_ij, only read. q[w, x, y, z][lane]: warm starts
 * in, unit quaternions out. r[3 i + j][lane] = R_ij. Fill unused lanes with a copy of a used one (or f = I, q
 * = 1). Each lane's result depends on that lane only, and is what sb_m3_polar gives up to rounding: lanes
 * that are hard, or have not converged after four steps, are handed to it. */
SB_INLINE void sb_polar_batch(sb_real (*SB_RESTRICT f)[SB_POLAR_LANES],
                              sb_real (*SB_RESTRICT q)[SB_POLAR_LANES],
                              sb_real (*SB_RESTRICT r)[SB_POLAR_LANES])
{
    sbi_polar_lanes s;
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        sb_real n = q[0][l] * q[0][l] + q[1][l] * q[1][l] + q[2][l] * q[2][l] + q[3][l] * q[3][l];
        int unit = (n > (sb_real)0.99) & (n < (sb_real)1.01);
        s.start[0][l] = s.q[0][l] = q[0][l], s.start[1][l] = s.q[1][l] = q[1][l];
        s.start[2][l] = s.q[2][l] = q[2][l], s.start[3][l] = s.q[3][l] = q[3][l];
        s.moving[l] = unit ? (sb_real)1 : (sb_real)0;
        s.hard[l] = unit ? (sb_real)0 : (sb_real)1;
    }
    for (int step = 0; step < SBI_POLAR_STEPS; step++) {
        sbi_polar_batch_step(f, &s);
        if (!sbi_polar_any(s.moving))
            break;
    }
    for (int l = 0; l < SB_POLAR_LANES; l++)
        s.hard[l] += s.moving[l];
    sbi_polar_batch_finish(&s, q, r);
    if (sbi_polar_any(s.hard))
        for (int l = 0; l < SB_POLAR_LANES; l++)
            if (s.hard[l] > 0)
                sbi_polar_lane(f, s.start, q, r, l);
}

#undef SBI_POLAR_STEPS
#undef SBI_POLAR_LAST
#undef SBI_POLAR_DEFINITE
#undef SBI_POLAR_LEAST
#undef SBI_POLAR_MOST

/* ---- small dense systems ----------------------------------------------------------------------------------
 * Row-major matrices in the caller's memory, factored in place; right-hand sides become solutions in place.
 * A factorisation returns 0, or k + 1 when step k meets a pivot that cannot be told from the rounding of the
 * sums that made it (singular, not positive definite), or that is not finite. That test does not depend on
 * units or on the scaling of rows and columns; a matrix that is singular only to rounding may pass it where
 * its leading part is ill conditioned too. After a failure the matrix is partly overwritten and must not be
 * used to solve. Multiply-adds: n^3/6 (Cholesky, LDL^T), n^3/3 (LU), m n^2 (QR). For n up to about 100. */

/* Is a pivot, made by n sums whose terms have the total size `size`, no more than their rounding (or NaN)? */
SB_INLINE int sbi_dense_is_lost(sb_real pivot, int n, sb_real size)
{
    return !(sb_abs(pivot) > 4 * (sb_real)n * SB_EPSILON * size) || !sb_is_finite(size);
}

SB_INLINE sb_real sbi_dense_dot(const sb_real *a, const sb_real *b, int count)
{
    sb_real sum = 0;
    for (int i = 0; i < count; i++)
        sum += a[i] * b[i];
    return sum;
}

/* a = L L^T for a symmetric positive definite a[n][n]. Reads and overwrites the lower triangle (L); the upper
 * one is left alone. Returns 0, or the failing column + 1. */
SB_INLINE int sb_cholesky_factor(sb_real *a, int n)
{
    for (int i = 0; i < n; i++) {
        sb_real *row = a + (size_t)i * (size_t)n, sum, pivot;
        for (int j = 0; j < i; j++) {
            const sb_real *other = a + (size_t)j * (size_t)n;
            row[j] = (row[j] - sbi_dense_dot(row, other, j)) / other[j];
        }
        sum = sbi_dense_dot(row, row, i);
        pivot = row[i] - sum;
        if (!(pivot > 0) || sbi_dense_is_lost(pivot, n, sb_abs(row[i]) + sum))
            return i + 1;
        row[i] = sb_sqrt(pivot);
    }
    return 0;
}

/* Solves L L^T x = b; l from sb_cholesky_factor, x replaces b[n]. */
SB_INLINE void sb_cholesky_solve(const sb_real *l, int n, sb_real *b)
{
    for (int i = 0; i < n; i++) {
        const sb_real *row = l + (size_t)i * (size_t)n;
        b[i] = (b[i] - sbi_dense_dot(row, b, i)) / row[i];
    }
    for (int i = n - 1; i >= 0; i--) {
        const sb_real *row = l + (size_t)i * (size_t)n;
        b[i] /= row[i];
        for (int j = 0; j < i; j++)
            b[j] -= row[j] * b[i];
    }
}

/* a = L D L^T, L with unit diagonal, D of either sign, for a symmetric a[n][n] whose leading minors are not 0
 * (positive or negative definite, or quasi-definite; no pivoting). Reads and overwrites the lower triangle: L
 * below the diagonal, D on it. Returns 0, or the failing column + 1. */
SB_INLINE int sb_ldlt_factor(sb_real *a, int n)
{
    for (int i = 0; i < n; i++) {
        sb_real *row = a + (size_t)i * (size_t)n, sum, size;
        for (int j = 0; j < i; j++) /* leaves row[j] = L_ij D_j */
            row[j] -= sbi_dense_dot(row, a + (size_t)j * (size_t)n, j);
        sum = row[i];
        size = sb_abs(row[i]);
        for (int j = 0; j < i; j++) {
            sb_real scaled = row[j];
            row[j] = scaled / a[(size_t)j * (size_t)n + (size_t)j];
            sum -= scaled * row[j];
            size += sb_abs(scaled * row[j]);
        }
        if (sbi_dense_is_lost(sum, n, size))
            return i + 1;
        row[i] = sum;
    }
    return 0;
}

/* Solves L D L^T x = b; l from sb_ldlt_factor, x replaces b[n]. */
SB_INLINE void sb_ldlt_solve(const sb_real *l, int n, sb_real *b)
{
    for (int i = 0; i < n; i++)
        b[i] -= sbi_dense_dot(l + (size_t)i * (size_t)n, b, i);
    for (int i = 0; i < n; i++)
        b[i] /= l[(size_t)i * (size_t)n + (size_t)i];
    for (int i = n - 1; i >= 0; i--)
        for (int j = 0; j < i; j++)
            b[j] -= l[(size_t)i * (size_t)n + (size_t)j] * b[i];
}

/* Column k of the LU factors above and on the diagonal and, not yet divided, below it. Returns the row of the
 * largest entry from k down, or -1 when no entry can be told from rounding. */
SB_INLINE int sbi_dense_lu_column(sb_real *a, int n, int k)
{
    sb_real best = 0, best_size = 0, size_total = 0;
    int row = k;
    for (int i = 0; i < n; i++) {
        sb_real *r = a + (size_t)i * (size_t)n, size = sb_abs(r[k]);
        for (int j = 0; j < i && j < k; j++) {
            sb_real product = r[j] * a[(size_t)j * (size_t)n + (size_t)k];
            r[k] -= product;
            size += sb_abs(product);
        }
        size_total += size;
        if (i >= k && sb_abs(r[k]) > best) {
            best = sb_abs(r[k]);
            best_size = size;
            row = i;
        }
    }
    return sbi_dense_is_lost(best, n, best_size) || !sb_is_finite(size_total) ? -1 : row;
}

/* P a = L U with row exchanges, for any regular a[n][n]. U replaces the upper triangle, L (unit diagonal) the
 * rest; pivot[k] (n ints) is the row exchanged with row k. Returns 0, or the failing column + 1. */
SB_INLINE int sb_lu_factor(sb_real *a, int n, int *pivot)
{
    for (int k = 0; k < n; k++) {
        int row = sbi_dense_lu_column(a, n, k);
        if (row < 0)
            return k + 1;
        pivot[k] = row;
        for (int j = 0; j < n && row != k; j++) {
            sb_real *one = a + (size_t)k * (size_t)n + (size_t)j,
                    *two = a + (size_t)row * (size_t)n + (size_t)j;
            sb_real swap = *one;
            *one = *two;
            *two = swap;
        }
        for (int i = k + 1; i < n; i++)
            a[(size_t)i * (size_t)n + (size_t)k] /= a[(size_t)k * (size_t)n + (size_t)k];
    }
    return 0;
}

/* Solves a x = b; lu and pivot from sb_lu_factor, x replaces b[n]. */
SB_INLINE void sb_lu_solve(const sb_real *lu, int n, const int *pivot, sb_real *b)
{
    for (int k = 0; k < n; k++) {
        sb_real swap = b[k];
        b[k] = b[pivot[k]];
        b[pivot[k]] = swap;
    }
    for (int i = 0; i < n; i++)
        b[i] -= sbi_dense_dot(lu + (size_t)i * (size_t)n, b, i);
    for (int i = n - 1; i >= 0; i--) {
        const sb_real *row = lu + (size_t)i * (size_t)n;
        b[i] = (b[i] - sbi_dense_dot(row + i + 1, b + i + 1, n - 1 - i)) / row[i];
    }
}

/* Length of a[0], a[stride], ... (count entries), without over- or underflow of squares. */
SB_INLINE sb_real sbi_dense_column_norm(const sb_real *a, int count, size_t stride)
{
    sb_real size = 0, sum = 0;
    for (int i = 0; i < count; i++) {
        sb_real entry = sb_abs(a[(size_t)i * stride]);
        size = entry > size || entry != entry ? entry : size;
    }
    if (!(size > 0) || !sb_is_finite(size))
        return size;
    for (int i = 0; i < count; i++) {
        sb_real entry = a[(size_t)i * stride] / size;
        sum += entry * entry;
    }
    return size * sb_sqrt(sum);
}

/* x -= tau v (v.x) with v = (1, a[stride], a[2 stride] ...) and x = x[0], x[step] ...; count entries each. */
SB_INLINE void sbi_dense_reflect(const sb_real *a, size_t stride, sb_real tau, sb_real *x, size_t step,
                                 int count)
{
    sb_real sum = x[0];
    for (int i = 1; i < count; i++)
        sum += a[(size_t)i * stride] * x[(size_t)i * step];
    sum *= tau;
    x[0] -= sum;
    for (int i = 1; i < count; i++)
        x[(size_t)i * step] -= sum * a[(size_t)i * stride];
}

/* a = Q R for a[m][n], m >= n, by Householder reflections I - tau v v^T. R replaces the upper triangle, v
 * (v_k = 1 implied) the rest; tau has n entries. Returns 0, or k + 1 when column k depends on those before it
 * (to rounding), is zero or not finite; m + n + 1 when m < n. */
SB_INLINE int sb_qr_factor(sb_real *a, int m, int n, sb_real *tau)
{
    size_t stride = (size_t)n;
    if (m < n)
        return m + n + 1;
    for (int k = 0; k < n; k++) {
        sb_real *v = a + (size_t)k * stride + (size_t)k, head, norm, whole;
        norm = sbi_dense_column_norm(v, m - k, stride);
        whole = sbi_dense_column_norm(a + k, m, stride); /* reflections keep it: the original length */
        if (sbi_dense_is_lost(norm, m, whole))
            return k + 1;
        head = v[0] > 0 ? -norm : norm; /* the sign without cancellation */
        tau[k] = (head - v[0]) / head;
        for (int i = 1; i < m - k; i++)
            v[(size_t)i * stride] /= v[0] - head;
        for (int j = k + 1; j < n; j++)
            sbi_dense_reflect(v, stride, tau[k], v + (j - k), stride, m - k);
        v[0] = head;
    }
    return 0;
}

/* Least squares: x of length n that minimises |a x - b|; qr and tau from sb_qr_factor. x replaces b[0..n);
 * the rest of b[m] becomes the part of b no x can reach: |a x - b| is its length. */
SB_INLINE void sb_qr_solve(const sb_real *qr, int m, int n, const sb_real *tau, sb_real *b)
{
    for (int k = 0; k < n; k++)
        sbi_dense_reflect(qr + (size_t)k * (size_t)n + (size_t)k, (size_t)n, tau[k], b + k, 1, m - k);
    for (int i = n - 1; i >= 0; i--) {
        const sb_real *row = qr + (size_t)i * (size_t)n;
        b[i] = (b[i] - sbi_dense_dot(row + i + 1, b + i + 1, n - 1 - i)) / row[i];
    }
}

/* Lower Cholesky factor of a symmetric positive definite 3x3 (its lower triangle is read), zeros above.
 * Returns 0, or the failing column + 1 with *l untouched. */
SB_INLINE int sb_m3_cholesky(sb_mat3 a, sb_mat3 *l)
{
    int failed = sb_cholesky_factor(&a.m[0][0], 3);
    if (failed)
        return failed;
    a.m[0][1] = a.m[0][2] = a.m[1][2] = 0;
    *l = a;
    return 0;
}

/* Inverse of a symmetric positive definite 3x3 (its lower triangle is read), exactly symmetric. Returns 0, or
 * the failing column + 1 with *inverse untouched. */
SB_INLINE int sb_m3_spd_inverse(sb_mat3 a, sb_mat3 *inverse)
{
    sb_mat3 l, g, result;
    int failed = sb_m3_cholesky(a, &l);
    if (failed)
        return failed;
    g = sb_m3_zero(); /* g = L^-1, a^-1 = g^T g */
    for (int i = 0; i < 3; i++)
        g.m[i][i] = (sb_real)1 / l.m[i][i];
    g.m[1][0] = -l.m[1][0] * g.m[0][0] * g.m[1][1];
    g.m[2][1] = -l.m[2][1] * g.m[1][1] * g.m[2][2];
    g.m[2][0] = -(l.m[2][0] * g.m[0][0] + l.m[2][1] * g.m[1][0]) * g.m[2][2];
    for (int i = 0; i < 3; i++)
        for (int j = 0; j <= i; j++) {
            sb_real sum = g.m[i][i] * g.m[i][j];
            for (int k = i + 1; k < 3; k++)
                sum += g.m[k][i] * g.m[k][j];
            result.m[i][j] = result.m[j][i] = sum;
        }
    *inverse = result;
    return 0;
}

#endif /* SB_DENSE_H */

/* ==== src/softbody/element.h ==== */
/* element: node orders, shape functions, quadrature, faces and edges of every element type. Floor 1. */
#ifndef SB_ELEMENT_H
#define SB_ELEMENT_H


/* Element types; the node orders are VTK's. tri6: edges 01 12 20. tet10: edges 01 12 02 03 13 23. */
typedef enum sb_element_type {
    SB_NO_ELEMENT = 0,
    SB_TRI3 = 1, /* surfaces */
    SB_TRI6 = 2,
    SB_QUAD4 = 3,
    SB_TET4 = 10, /* volumes */
    SB_TET10 = 11,
    SB_HEX8 = 12
} sb_element_type;

enum { SB_MAX_ELEMENT_NODES = 27, SB_MAX_FACE_NODES = 9, SB_MAX_QUADRATURE_POINTS = 27 };

/* ---- the compiled element types -----------------------------------------------------------------------
 * `#define SB_ELEMENT SB_TET10` before including compiles the loops over one volume type only. The
 * preprocessor cannot compare enum names, so each name has a code to paste. */
#define SBI_ELEMENT_CODE_SB_TET4 10
#define SBI_ELEMENT_CODE_SB_TET10 11
#define SBI_ELEMENT_CODE_SB_HEX8 12
#ifdef SB_ELEMENT
#define SBI_ELEMENT_PINNED SBI_PASTE(SBI_ELEMENT_CODE_, SB_ELEMENT)
#if SBI_ELEMENT_PINNED != 10 && SBI_ELEMENT_PINNED != 11 && SBI_ELEMENT_PINNED != 12
#error "softbody.h: SB_ELEMENT must be SB_TET4, SB_TET10 or SB_HEX8"
#endif
#else
#define SBI_ELEMENT_PINNED 0
#endif
/* 1 when loops over the volume type (a literal name: SB_TET4, SB_TET10, SB_HEX8) are compiled; works in
 * #if. */
#define SBI_ELEMENT_ENABLED(type) (SBI_ELEMENT_PINNED == 0 || SBI_ELEMENT_PINNED == SBI_ELEMENT_CODE_##type)

/* The volume type to dispatch on: a constant when SB_ELEMENT pins one. The caller has refused other types. */
SB_INLINE sb_element_type sbi_element_type_or_pinned(sb_element_type type)
{
#ifdef SB_ELEMENT
    (void)type;
    return SB_ELEMENT;
#else
    return type;
#endif
}
/* 1 for a volume type that this build simulates, else 0. */
SB_INLINE int sbi_element_is_enabled(sb_element_type type)
{
    return (SBI_ELEMENT_ENABLED(SB_TET4) && type == SB_TET4) ||
           (SBI_ELEMENT_ENABLED(SB_TET10) && type == SB_TET10) ||
           (SBI_ELEMENT_ENABLED(SB_HEX8) && type == SB_HEX8);
}

/* ---- counts ----------------------------------------------------------------------------------------------
 * All return 0 for a type that is none of the above. */

/* Nodes per element. */
SB_INLINE int sb_element_node_count(sb_element_type type)
{
    switch (type) {
    case SB_TRI3: return 3;
    case SB_TRI6: return 6;
    case SB_QUAD4: return 4;
    case SB_TET4: return 4;
    case SB_TET10: return 10;
    case SB_HEX8: return 8;
    case SB_NO_ELEMENT: break;
    }
    return 0;
}
/* Corners per element; they are the first nodes. */
SB_INLINE int sb_element_corner_count(sb_element_type type)
{
    switch (type) {
    case SB_TRI3:
    case SB_TRI6: return 3;
    case SB_QUAD4:
    case SB_TET4:
    case SB_TET10: return 4;
    case SB_HEX8: return 8;
    case SB_NO_ELEMENT: break;
    }
    return 0;
}
/* 2 for a surface, 3 for a volume. */
SB_INLINE int sb_element_dimension(sb_element_type type)
{
    int corners = sb_element_corner_count(type);
    return corners == 0 ? 0 : (type < SB_TET4 ? 2 : 3);
}
/* Faces per volume element; 0 for surfaces. */
SB_INLINE int sb_element_face_count(sb_element_type type)
{
    return sb_element_dimension(type) != 3 ? 0 : (type == SB_HEX8 ? 6 : 4);
}
/* Edges per element. */
SB_INLINE int sb_element_edge_count(sb_element_type type)
{
    int corners = sb_element_corner_count(type);
    return sb_element_dimension(type) == 3 ? (corners == 4 ? 6 : 12) : corners;
}

/* ---- names, faces, edges ------------------------------------------------------------------------------- */

/* Name of a type, e.g. "tet4"; "unknown" for none of them. Static storage. */
SB_API const char *sb_element_name(sb_element_type type);

/* Local node numbers of face `face` in [0, face_count), counter-clockwise seen from outside, and the face's
 * type (tri3, tri6, quad4; face_type may be NULL). Returns the number of nodes, 0 (nothing written) for no
 * such face. */
SB_API int sb_element_face(sb_element_type type, int face, int nodes[SB_MAX_FACE_NODES],
                           sb_element_type *face_type);

/* Local node numbers of edge `edge` in [0, edge_count): both ends, then the node between them or -1. Returns
 * the number of nodes on the edge (2 or 3), 0 (nothing written) for no such edge. */
SB_API int sb_element_edge(sb_element_type type, int edge, int nodes[3]);

/* ---- shape functions ----------------------------------------------------------------------------------
 * Parameters xi: triangles and tets r, s, t >= 0 with r + s + t <= 1 (corner 0 at the origin); quad and hex
 * [-1, 1] each. The third parameter of a surface is ignored. */

/* Parameters of local node `node`; returns 1, or 0 (nothing written) for no such node. */
SB_API int sb_element_node_point(sb_element_type type, int node, sb_real xi[3]);

/* Shape functions N and their gradients dN/dxi at xi. shape: [nodes] or NULL; gradient: [nodes][3] or NULL,
 * the third component 0 for surfaces. Nothing is written for an unknown type. */
SB_API void sb_element_shape(sb_element_type type, const sb_real xi[3], sb_real *shape,
                             sb_real (*gradient)[3]);

/* ---- quadrature -----------------------------------------------------------------------------------------*/

/* What a rule must integrate. Surfaces have one rule, good for all four; volumes have no
 * SB_QUADRATURE_FACE. */
typedef enum sb_quadrature_kind {
    SB_QUADRATURE_STIFFNESS = 0,        /* straight sides: tet4 1 point, tet10 4, hex8 8 */
    SB_QUADRATURE_STIFFNESS_CURVED = 1, /* curved sides: tet10 8 (4 fail the patch test), others as above */
    SB_QUADRATURE_MASS = 2,             /* exact consistent mass: tet4 4, tet10 14, hex8 8 */
    SB_QUADRATURE_FACE = 3              /* surface loads: tri3 3, tri6 6, quad4 4 */
} sb_quadrature_kind;

/* Points (parameters xi) and weights of a rule; the weights sum to the parameter domain's measure (tet 1/6,
 * triangle 1/2, hex 8, quad 4). Returns the number of points, 0 (nothing written) when there is no such rule.
 * Point order: tets by the corner a point is nearest to, hexes with xi fastest, as in Abaqus and CalculiX. */
SB_API int sb_element_quadrature(sb_element_type type, sb_quadrature_kind kind,
                                 sb_real points[SB_MAX_QUADRATURE_POINTS][3],
                                 sb_real weights[SB_MAX_QUADRATURE_POINTS]);

#endif /* SB_ELEMENT_H */

/* ==== src/softbody/mesh.h ==== */
/* mesh: nodes, elements, regions; checks, repairs, boundary, neighbours, quality, reordering. Floor 1. */
#ifndef SB_MESH_H
#define SB_MESH_H


/* A mesh of one element type: a volume (tet4, tet10, hex8) or a surface (tri3, tri6, quad4). Fill the arrays
 * by hand or let sb_mesh_load / a generator do it. Zero-initialise before first use ({0}). Arrays made by
 * this library come from `allocator` and are released with sb_mesh_free; arrays of your own are yours to
 * release. */
typedef struct sb_mesh {
    int node_count;
    sb_vec3 *nodes; /* [node_count] positions (m) */
    sb_element_type element_type;
    int element_count;
    int *elements;          /* [element_count][nodes per element] node indices */
    int *regions;           /* [element_count] material region of each element, or NULL: all 0 */
    sb_allocator allocator; /* what the arrays came from; zeros: malloc */
} sb_mesh;

/* Common to all calls below: a NULL allocator means malloc and free. `error` may be NULL. Calls that return
 * an sb_result check counts, type and node indices first, so no content of the arrays makes them read
 * outside. An output mesh or table is overwritten, not freed. Nothing depends on addresses or threads. */

/* Releases the arrays through mesh->allocator and zeroes the struct. Safe on {0} and on NULL. */
SB_API void sb_mesh_free(sb_mesh *mesh);

/* Deep copy with memory from `allocator`. */
SB_API sb_result sb_mesh_copy(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *copy,
                              sb_error *error);

/* ---- checks ------------------------------------------------------------------------------------------ */

/* Tells whether a mesh can be computed with: counts, finite nodes, index range, repeated nodes and, for
 * volumes, a positive Jacobian (at the corners; curved tet10 also at its mid-edge nodes, on its faces and
 * inside). SB_ERROR_ARGUMENT, _NOT_FINITE (error->node is the first), _INDEX or _MESH (error->element is the
 * first; the message lists up to 8 elements and the total). Allocates nothing; one pass. */
SB_API sb_result sb_mesh_validate(const sb_mesh *mesh, sb_error *error);

/* What can be wrong with an element; an element is listed once, under the first that applies. A bad mid-edge
 * node lies far from its edge, or the whole file has the node order of another program (gmsh). */
typedef enum sb_mesh_defect {
    SB_MESH_SOUND = 0,
    SB_MESH_INDEX_RANGE = 1,     /* refers to a node that does not exist */
    SB_MESH_NODE_NOT_FINITE = 2, /* uses a node with a NaN or infinite coordinate */
    SB_MESH_REPEATED_NODE = 3,   /* uses a node twice */
    SB_MESH_INVERTED = 4,        /* volume: negative Jacobian at a corner of the straight-sided element */
    SB_MESH_FLAT = 5,            /* volume or area zero to rounding */
    SB_MESH_BAD_MIDSIDE = 6,     /* tet10 with sound corners, folded somewhere by its mid-edge nodes */
    SB_MESH_DUPLICATE = 7,       /* same corners as an element before it */
    SB_MESH_DEFECT_COUNT = 8
} sb_mesh_defect;

typedef struct sb_mesh_bad_element {
    int element;
    sb_mesh_defect defect;
} sb_mesh_bad_element;

/* Everything sb_mesh_check found. Free with sb_mesh_report_free. */
typedef struct sb_mesh_report {
    int bad_count;
    sb_mesh_bad_element *bad;               /* [bad_count] in the order of the elements */
    int defect_count[SB_MESH_DEFECT_COUNT]; /* elements per sb_mesh_defect; [0] the sound ones */
    int not_finite_nodes;                   /* nodes with a NaN or infinite coordinate */
    int first_not_finite_node;              /* or -1 */
    int unreferenced_nodes;      /* nodes of no element: a stiffness matrix with them is singular */
    int first_unreferenced_node; /* or -1 */
    int duplicate_nodes;         /* nodes that sb_mesh_merge_nodes with automatic tolerance would remove */
    int components;              /* parts that share no node; each needs supports of its own */
    sb_real volume; /* m^3: volume mesh: sum; closed surface: enclosed, negative when inside out */
    sb_real area;   /* m^2: surfaces; 0 for volumes */
    sb_real min_edge, max_edge; /* m, straight corner to corner */
    sb_real worst_quality;    /* smallest sb_mesh_element_quality of the elements that are not bad; 0: none */
    int worst_element;        /* its element, or -1 */
    int boundary_faces;       /* volumes: faces of one element only */
    int nonmanifold_faces;    /* volumes: faces of more than two elements */
    int open_edges;           /* surfaces: edges of one element only; 0: closed */
    int nonmanifold_edges;    /* surfaces: edges of more than two elements */
    int inconsistent_edges;   /* surfaces: edges whose two elements are oriented against each other */
    int nonmanifold_vertices; /* surfaces: nodes where parts touch in a point */
    sb_allocator allocator;
} sb_mesh_report;

/* Lists everything suspicious about a mesh in one report, whatever the arrays hold. SB_OK also for a bad
 * mesh; fails with SB_ERROR_ARGUMENT (counts, type, null arrays) or SB_ERROR_MEMORY only. Elements with an
 * index out of range or a repeated node take no part in the topology, bad ones none in volume, area and
 * quality. O(nodes + elements). */
SB_API sb_result sb_mesh_check(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh_report *report,
                               sb_error *error);
SB_API void sb_mesh_report_free(sb_mesh_report *report);

/* ---- geometry ------------------------------------------------------------------------------------------
 * For meshes that sb_mesh_validate accepts. An element out of range gives 0. */

/* Volume of an element (m^3), exact for curved ones too; negative when inverted; 0 for surfaces. */
SB_API sb_real sb_mesh_element_volume(const sb_mesh *mesh, int element);
/* Volume mesh: its volume (m^3). Surface: the signed volume it encloses, meaningful when it is closed. */
SB_API sb_real sb_mesh_volume(const sb_mesh *mesh);
/* Area of a surface mesh (m^2), exact for tri3, by the face quadrature else; 0 for volumes (take the
 * boundary). */
SB_API sb_real sb_mesh_surface_area(const sb_mesh *mesh);
/* Smallest box around all nodes (m); both corners 0 for a mesh without nodes. */
SB_API void sb_mesh_bounds(const sb_mesh *mesh, sb_vec3 *low, sb_vec3 *high);
/* Shape of an element: 1 is best, <= 0 inverted or flat. tet4: mean ratio 12 (3V)^(2/3) / sum of squared
 * edges; tet10: that of its corners times min/max of the Jacobian; hex8 and quad4: smallest Jacobian at a
 * corner of edges scaled to length 1; triangles: 4 sqrt(3) A / sum of squared edges (of the corners). */
SB_API sb_real sb_mesh_element_quality(const sb_mesh *mesh, int element);

/* ---- repairs, on request only ---------------------------------------------------------------------------
 * They change the mesh in place, take scratch from mesh->allocator and leave the mesh as it was on failure.
 * They work on meshes with bad elements, as long as indices are in range and nodes finite. The counts they
 * return may be NULL: not wanted. */

/* Turns inverted volume elements (corner volume negative) by renumbering them; surfaces:
 * sb_mesh_orient_surface. *flipped: how many. Mid-edge nodes move along. What cannot be mended that way stays
 * for sb_mesh_validate. */
SB_API sb_result sb_mesh_orient(sb_mesh *mesh, int *flipped, sb_error *error);
/* Orients a surface consistently: floods over the edges of exactly two elements; a closed part is turned
 * outward (its enclosed volume positive), an open one as most of its elements were. SB_ERROR_MESH when it is
 * one-sided. */
SB_API sb_result sb_mesh_orient_surface(sb_mesh *mesh, int *flipped, sb_error *error);
/* Merges nodes that lie within `tolerance` (m) of a node before them; negative: 1e-6 of the longest side of
 * the bounding box; 0: equal coordinates only. *merged: nodes removed. Elements may collapse: validate
 * afterwards. */
SB_API sb_result sb_mesh_merge_nodes(sb_mesh *mesh, sb_real tolerance, int *merged, sb_error *error);
/* Removes nodes of no element; *removed: how many. */
SB_API sb_result sb_mesh_remove_unreferenced(sb_mesh *mesh, int *removed, sb_error *error);
/* Removes elements with the same corners as an element before them; *removed: how many. */
SB_API sb_result sb_mesh_remove_duplicate_elements(sb_mesh *mesh, int *removed, sb_error *error);
/* Multiplies all coordinates by factor > 0 (0.001: millimetres to metres). */
SB_API sb_result sb_mesh_scale(sb_mesh *mesh, sb_real factor, sb_error *error);

/* ---- topology ------------------------------------------------------------------------------------------ */

/* A table of node or element indices. Free with sb_index_table_free. */
typedef struct sb_index_table {
    int rows, columns;
    int *items; /* [rows][columns] */
    sb_allocator allocator;
} sb_index_table;
SB_API void sb_index_table_free(sb_index_table *table);

/* Lists of different length: list i is items[offsets[i]] .. items[offsets[i + 1] - 1]. */
typedef struct sb_index_lists {
    int count;
    int *offsets; /* [count + 1] */
    int *items;   /* [offsets[count]] */
    sb_allocator allocator;
} sb_index_lists;
SB_API void sb_index_lists_free(sb_index_lists *lists);

/* The boundary of a volume mesh. Free with sb_boundary_free. */
typedef struct sb_boundary {
    sb_mesh surface; /* tri3, tri6 or quad4, oriented outward; regions are those of the volume elements */
    int *elements;   /* [surface.element_count] volume element of each face */
    int *faces;      /* [surface.element_count] its local face, as in sb_element_face */
    int *nodes;      /* [surface.node_count] volume node of each surface node; NULL when not compacted */
} sb_boundary;
SB_API void sb_boundary_free(sb_boundary *boundary);

/* Faces that belong to one element only, in the order of elements and faces. compact 0: the surface keeps all
 * nodes and the numbering of the volume; 1: it keeps the nodes it uses, in their order. */
SB_API sb_result sb_mesh_boundary(const sb_mesh *mesh, int compact, const sb_allocator *allocator,
                                  sb_boundary *boundary, sb_error *error);
/* Neighbour of each element across each face (surfaces: across each edge), [elements][faces or edges]; -1
 * where there is none or more than one. */
SB_API sb_result sb_mesh_neighbours(const sb_mesh *mesh, const sb_allocator *allocator,
                                    sb_index_table *neighbours, sb_error *error);
/* Every edge once, corner to corner, [edges][2] with the smaller node first, sorted. */
SB_API sb_result sb_mesh_edges(const sb_mesh *mesh, const sb_allocator *allocator, sb_index_table *edges,
                               sb_error *error);
/* The elements of each node, ascending. */
SB_API sb_result sb_mesh_node_elements(const sb_mesh *mesh, const sb_allocator *allocator,
                                       sb_index_lists *lists, sb_error *error);
/* Part number of each element, [elements][1], from 0 in the order of their first element; elements that share
 * a node belong together. *count (or NULL): number of parts. */
SB_API sb_result sb_mesh_components(const sb_mesh *mesh, const sb_allocator *allocator,
                                    sb_index_table *labels, int *count, sb_error *error);

/* ---- conversions --------------------------------------------------------------------------------------- */

/* The tet10 mesh with straight edges of a tet4 mesh: old nodes first, then one node per edge. Regions are
 * kept. */
SB_API sb_result sb_mesh_to_tet10(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *tet10,
                                  sb_error *error);
/* Renumbers nodes by reverse Cuthill-McKee and sorts elements by their lowest node: small bandwidth, good
 * cache use. node_map [nodes] and element_map [elements] (each may be NULL) receive the new number of each
 * old one. */
SB_API sb_result sb_mesh_reorder(sb_mesh *mesh, int *node_map, int *element_map, sb_error *error);

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* ---- internal ------------------------------------------------------------------------------------------ */

/* Counts, type and pointers of a mesh, finite nodes and index range: what every room needs before it walks
 * one. */
SBI_API sb_result sbi_mesh_check_arrays(const sb_mesh *mesh, sb_error *error);
/* Arrays for a mesh, their contents not set; 0 (and nothing allocated) when memory is short. */
SBI_API int sbi_mesh_allocate(sb_mesh *mesh, sb_element_type type, int node_count, int element_count,
                              int with_regions, const sb_allocator *allocator);
#endif

#endif /* SB_MESH_H */

/* ==== src/softbody/meshgen.h ==== */
/* meshgen: structured volume meshes of simple solids. Floor 2.
 * Blocks of hexahedral cells; tets are cells cut along diagonals that match between neighbours. */
#ifndef SB_MESHGEN_H
#define SB_MESHGEN_H


/* Common to all: type is tet4, tet10 (straight edges) or hex8; the mesh is overwritten, not freed, and its
 * arrays come from `allocator` (NULL: malloc). SB_ERROR_ARGUMENT for a type, count or size out of range (the
 * node and element counts must fit an int), SB_ERROR_MEMORY; then the mesh is untouched. Same bits on every
 * machine. */

/* Box from the origin to `size` (m, each > 0) of nx * ny * nz cells (each >= 1); a cell is 1 hex or 6 tets
 * (Kuhn's). Corner nodes are numbered with x fastest, then y. */
SB_API sb_result sb_mesh_beam(sb_element_type type, int nx, int ny, int nz, sb_vec3 size,
                              const sb_allocator *allocator, sb_mesh *mesh, sb_error *error);

/* Solid cylinder of `radius` and `length` (m, > 0) around coordinate axis 0 (x), 1 (y) or 2 (z), from 0 to
 * length along it. across: cells over the diameter in [4, 20000], along >= 1: layers. Boundary nodes lie on
 * the cylinder, so the volume is too small by O(1/across^2). Nodes are numbered layer by layer. */
SB_API sb_result sb_mesh_cylinder(sb_element_type type, int axis, sb_real radius, sb_real length, int across,
                                  int along, const sb_allocator *allocator, sb_mesh *mesh, sb_error *error);

/* Solid ellipsoid around the origin with semi-axes (m, each > 0); cells over each diameter in [4, 500].
 * Boundary nodes lie on the ellipsoid. */
SB_API sb_result sb_mesh_ellipsoid(sb_element_type type, sb_vec3 semi_axes, int cells,
                                   const sb_allocator *allocator, sb_mesh *mesh, sb_error *error);

/* A solid like a human liver for demonstrations: 1.5 litre (1.2 at 4 cells), 20 cm wide (x, the thick right
 * lobe at negative x), dome above (z up), hollow below, a notch in the front edge (negative y). cells in [4,
 * 60] over its width; every element is sound (sb_mesh_element_quality above 0.2). */
SB_API sb_result sb_mesh_organ(sb_element_type type, int cells, const sb_allocator *allocator, sb_mesh *mesh,
                               sb_error *error);

#endif /* SB_MESHGEN_H */

/* ==== src/softbody/meshio.h ==== */
/* meshio: reads and writes mesh files. Floor 1: calls core, dense, element and mesh.
 *
 *     file ---> bounded reader ---> cells of any kind ---> one element type ---> checked sb_mesh
 *
 * A file is untrusted input: nothing is read outside it, no memory is taken for a count that the file is too
 * short to hold, and the time grows linearly with the file (n log n where node numbers are scattered or
 * vertices are merged).
 *
 * | format     | read                                                         | written              |
 * |------------|--------------------------------------------------------------|----------------------|
 * | VTK legacy | 2.0 to 5.1, ASCII and binary, UNSTRUCTURED_GRID and POLYDATA | 3.0, ASCII, binary   |
 * | gmsh       | 2.x and 4.1, ASCII and binary                                |                      |
 * | TetGen     | .node with .ele                                              |                      |
 * | OBJ        | vertices and faces                                           | ASCII                |
 * | STL        | ASCII and binary                                             | binary               |
 * | PLY        | ASCII, binary of both byte orders                            | binary little-endian |
 * | OFF        | ASCII, also COFF, NOFF, STOFF                                |                      |
 *
 * Numbers are parsed and written without regard to the locale; reading rounds correctly, so what is written
 * in full precision comes back with the same bits. */
#ifndef SB_MESHIO_H
#define SB_MESHIO_H


/* ---- reading ----------------------------------------------------------------------------------------- */

typedef enum sb_file_format {
    SB_FILE_AUTO = 0, /* told by the content, else by the end of the name */
    SB_FILE_VTK = 1,
    SB_FILE_GMSH = 2,
    SB_FILE_TETGEN = 3,
    SB_FILE_OBJ = 4,
    SB_FILE_STL = 5,
    SB_FILE_PLY = 6,
    SB_FILE_OFF = 7
} sb_file_format;

/* What a successful load did besides copying numbers. */
typedef struct sb_load_report {
    sb_file_format format;  /* what the file turned out to be */
    int file_cells;         /* cells, elements or faces in the file */
    int skipped_cells;      /* left out, because their dimension is lower than the mesh's */
    int split_polygons;     /* faces of 4 or more corners, and strips, that were cut into triangles */
    int merged_vertices;    /* STL: corners that were found to be a vertex met before */
    int flipped_elements;   /* renumbered, because they were inverted */
    int unreferenced_nodes; /* nodes of no element; kept, so that node numbers stay those of the file */
} sb_load_report;

/* How to load. Start from sb_default_load_options(). */
typedef struct sb_load_options {
    sb_real scale;          /* > 0, multiplies every coordinate; 1; files in millimetres: 0.001 */
    int fix_orientation;    /* 0: an element that is inverted among others that are not is an error. 1: it is
                             * turned; surfaces are oriented by sb_mesh_orient_surface */
    sb_allocator allocator; /* for the mesh and while loading; zeros: malloc */
    sb_load_report *report; /* filled on success; NULL: not wanted */
    int cookie;             /* set by sb_default_load_options; tells options that were never initialised */
} sb_load_options;

/* Scale 1, nothing is repaired, malloc, no report. */
SB_API sb_load_options sb_default_load_options(void);

/* Reads a mesh from a file.
 *
 * mesh     overwritten on success (free it first when it owns arrays), untouched on failure; free it with
 *          sb_mesh_free
 * path     the format is told by the content, else by the ending. TetGen: the .node or the .ele file, the
 *          other one is looked for beside it
 * options  NULL: sb_default_load_options()
 * error    may be NULL; says file and line (line 0 in binary parts, where the message has the byte offset),
 *          and the node or element: the cell of the file, counted from 0, or with SB_ERROR_MESH the element
 *          of the mesh it would have become
 *
 * The cells of the highest dimension become the mesh, and must be of one type: tet4, tet10, hex8, or for
 * surfaces tri3, tri6, quad4. Triangles mixed with quadrilaterals, and polygons of OBJ, PLY, OFF and
 * POLYDATA, become tri3; polygons are cut into a fan at their first corner, which is right for convex ones.
 * Node orders of gmsh and TetGen are turned into VTK's. Regions come from the cell field `region` (VTK), the
 * first physical group of the volume (gmsh; of the surface in a surface file) or the first attribute
 * (TetGen); regions is NULL when all are 0.
 *
 * A volume mesh is checked with sb_mesh_validate. When all its elements are inverted, that is the file's
 * convention: they are turned and counted in the report. A surface is loaded as it is, since scans are seldom
 * perfect: look at it with sb_mesh_check.
 *
 * SB_ERROR_ARGUMENT (null pointer, options), _FILE (cannot be read), _FORMAT, _NOT_FINITE (coordinate, also
 * one too large for sb_real), _INDEX (node that does not exist), _MESH (inverted or flat elements, no
 * elements), _UNSUPPORTED (names the version, data set or element type) or _MEMORY. */
SB_API sb_result sb_mesh_load(sb_mesh *mesh, const char *path, const sb_load_options *options,
                              sb_error *error);

/* Reads a mesh from memory, as sb_mesh_load does from a file.
 *
 * data     [size] bytes, borrowed during the call; may be NULL when size is 0
 * format   SB_FILE_AUTO or any but SB_FILE_TETGEN, which needs two files
 * name     stands for the path in errors and in telling the format; may be NULL */
SB_API sb_result sb_mesh_load_memory(sb_mesh *mesh, const void *data, size_t size, sb_file_format format,
                                     const char *name, const sb_load_options *options, sb_error *error);

/* ---- writing -----------------------------------------------------------------------------------------
 * All writers check the mesh first (SB_ERROR_ARGUMENT, _NOT_FINITE, _INDEX) and touch no file then. They take
 * no memory. When writing fails (SB_ERROR_FILE: no such folder, disk full) no part of a file stays behind; a
 * file that was there before is then empty. */

typedef enum sb_field_location { SB_FIELD_NODES = 0, SB_FIELD_ELEMENTS = 1 } sb_field_location;

/* Values to write along with a mesh; everything is borrowed. */
typedef struct sb_field {
    const char *name; /* printable ASCII without blanks */
    sb_field_location location;
    int components;        /* 1 scalar; 2 or 4 plain arrays; 3 vector; 6 symmetric tensor xx yy zz xy yz xz;
                            * 9 tensor, row by row */
    const sb_real *values; /* [nodes or elements][components], finite */
} sb_field;

/* Writes a legacy VTK 3.0 unstructured grid in ASCII, with fields, and mesh->regions as the cell field
 * `region`. The numbers are exact: %.17g (%.9g when sb_real is float). fields may be NULL when field_count
 * is 0. */
SB_API sb_result sb_mesh_save_vtk(const char *path, const sb_mesh *mesh, const sb_field *fields,
                                  int field_count, sb_error *error);
/* The same in VTK's big-endian binary form: smaller, faster, exact. */
SB_API sb_result sb_mesh_save_vtk_binary(const char *path, const sb_mesh *mesh, const sb_field *fields,
                                         int field_count, sb_error *error);

/* Surfaces of tri3 or quad4; other meshes are SB_ERROR_UNSUPPORTED (a volume: see sb_mesh_boundary). */

/* OBJ with v and f lines, exact numbers. */
SB_API sb_result sb_mesh_save_obj(const char *path, const sb_mesh *mesh, sb_error *error);
/* Binary STL: coordinates are rounded to float, shared vertices and unused nodes are lost, quad4 become two
 * triangles. */
SB_API sb_result sb_mesh_save_stl(const char *path, const sb_mesh *mesh, sb_error *error);
/* Binary little-endian PLY, coordinates in the precision of sb_real. */
SB_API sb_result sb_mesh_save_ply(const char *path, const sb_mesh *mesh, sb_error *error);

#endif /* SB_MESHIO_H */

/* ==== src/softbody/material.h ==== */
/* material: constitutive models at one point: energy, stress and tangent of a deformation gradient. Floor 1.
 *
 * Every model is isotropic and elastic: W(F) [J/m^3 of reference volume], P = dW/dF [Pa] (the first
 * Piola-Kirchhoff stress) and A = dP/dF [Pa], with F = dx/dX dimensionless and J = det F. No function
 * allocates or keeps state; all are thread-safe.
 *
 * Two ways in: sb_material_energy/stress/tangent choose the model at run time and check their input; the
 * sbi_..._inline workers take the model as a literal first argument, so that a loop over integration
 * points instantiated per model contains that model's arithmetic only. */
#ifndef SB_MATERIAL_H
#define SB_MATERIAL_H


typedef enum sb_material_model {
    /* Small strain e = sym(F) - I: lambda/2 tr(e)^2 + mu e:e; a rotation strains it. */
    SB_LINEAR = 1,
    /* F = R S: mu |F - R|^2 + lambda/2 tr(S - I)^2, R warm-started. */
    SB_COROTATED = 2,
    /* The same energy with R from the signed SVD at each call: no history (Irving et al. 2004). */
    SB_COROTATED_INVERTIBLE = 3,
    /* St.Venant-Kirchhoff, E = (F^T F - I)/2: lambda/2 tr(E)^2 + mu E:E. */
    SB_SVK = 4,
    /* mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2, I1 = F:F; needs J > 0. */
    SB_NEO_HOOKEAN = 5,
    /* C10 (J^(-2/3) I1 - 3) + (J - 1)^2/D1; needs J > 0. */
    SB_NEO_HOOKEAN_ISOCHORIC = 6,
    /* mu/2 (I1 - 3) - mu (J - 1) + (lambda + mu)/2 (J - 1)^2 (after Smith et al. 2018). */
    SB_STABLE_NEO_HOOKEAN = 7,
    /* C10 (I1b - 3) + C01 (I2b - 3) + (J - 1)^2/D1, I1b = J^(-2/3) I1, I2b = J^(-4/3) I2; needs J > 0. */
    SB_MOONEY_RIVLIN = 8,
    /* sum over i = 1..3 of Ci0 (I1b - 3)^i, + (J - 1)^2/D1; needs J > 0. */
    SB_REDUCED_POLYNOMIAL = 9
} sb_material_model;

enum { SB_MAX_PRONY_TERMS = 8 };

/* A material: plain data, filled by a constructor below or by hand (then see sb_material_check). The
 * constructors set every field for every model: all models have Hooke's tangent with lambda, mu at F = I,
 * and c10 = mu/2, d1 = 2/bulk. Only SB_NEO_HOOKEAN_ISOCHORIC evaluates c10 and d1; the others evaluate
 * lambda and mu. */
typedef struct sb_material {
    sb_material_model model;
    sb_real density; /* mass per reference volume [kg/m^3], > 0; soft tissue: 900 to 1100 */
    sb_real lambda;  /* first Lame constant [Pa]; lambda + 2 mu/3 > 0 */
    sb_real mu;      /* shear modulus [Pa], > 0 */
    sb_real c10;     /* [Pa], > 0 */
    sb_real d1;      /* [1/Pa], > 0; in Abaqus' convention, bulk = 2/d1 */
    sb_real c01;     /* [Pa]; Mooney-Rivlin, else 0 */
    sb_real c20, c30; /* [Pa]; reduced polynomial, else 0 */
    sb_real fibre_stiffness; /* k1 [Pa], >= 0; 0: no fibres */
    sb_real fibre_exponent;  /* k2, >= 0 */
    int prony_count; /* terms of g(t) = 1 - sum g_i (1 - exp(-t/tau_i)); 0: elastic */
    sb_real prony_g[SB_MAX_PRONY_TERMS];   /* each in (0, 1), their sum below 1 */
    sb_real prony_tau[SB_MAX_PRONY_TERMS]; /* [s], > 0 */
} sb_material;

/* Which derivative of P a solver gets. */
typedef enum sb_tangent_kind {
    SB_TANGENT_EXACT = 0, /* dP/dF: quadratic Newton, may be indefinite under compression */
    SB_TANGENT_SPD = 1,   /* nearest positive semidefinite matrix: negative eigenvalues replaced by 0 */
    SB_TANGENT_QUASI = 2  /* corotated models: rotated Hooke tangent (dR ignored), semidefinite and cheapest;
                             other models: as SB_TANGENT_SPD */
} sb_tangent_kind;

/* ---- constructors ------------------------------------------------------------------------------------
 * young [Pa] > 0, poisson in (-1, 0.5), density [kg/m^3] > 0. Nothing is checked here: parameters out
 * of range give a material that sb_material_check refuses. */
SB_API sb_material sb_material_linear(sb_real young, sb_real poisson, sb_real density);
SB_API sb_material sb_material_corotated(sb_real young, sb_real poisson, sb_real density);
SB_API sb_material sb_material_corotated_invertible(sb_real young, sb_real poisson, sb_real density);
SB_API sb_material sb_material_svk(sb_real young, sb_real poisson, sb_real density);
SB_API sb_material sb_material_neo_hookean(sb_real young, sb_real poisson, sb_real density);
SB_API sb_material sb_material_stable_neo_hookean(sb_real young, sb_real poisson, sb_real density);
/* c10 [Pa] > 0, d1 [1/Pa] > 0: Abaqus' and CalculiX' constants, mu = 2 c10 and bulk = 2/d1. */
SB_API sb_material sb_material_neo_hookean_isochoric(sb_real c10, sb_real d1, sb_real density);

/* Constants of the small-strain limit: Young's modulus [Pa], Poisson's ratio, bulk modulus [Pa]. */
SB_API sb_real sb_material_young(const sb_material *material);
SB_API sb_real sb_material_poisson(const sb_material *material);
SB_API sb_real sb_material_bulk(const sb_material *material);

/* Checks model, finiteness and ranges of a material (mu > 0, bulk > 0, density > 0, Poisson's ratio in
 * (-1, 0.5); isochoric: c10, d1 > 0 and in agreement with lambda, mu). Returns SB_OK, or SB_ERROR_ARGUMENT
 * (NULL, unknown model), SB_ERROR_NOT_FINITE or SB_ERROR_MATERIAL with the offending value in error (may
 * be NULL). */
SB_API sb_result sb_material_check(const sb_material *material, sb_error *error);

/* 1 when the model has a finite energy for J <= 0; 0 when it needs J > 0 (or is unknown). SB_SVK has one,
 * but does not oppose inversion: it cannot tell F from its mirror image, so an inverted element may come
 * to rest. */
SB_API int sb_material_allows_inversion(sb_material_model model);
/* 1 when the tangent does not depend on F. */
SB_API int sb_material_is_linear(sb_material_model model);

/* ---- evaluation at one point -------------------------------------------------------------------------
 * F: deformation gradient. rotation: SB_COROTATED's warm start, a unit quaternion read and overwritten with
 * the rotation of F (from a near-by F it saves most of the work); NULL starts cold. Other models leave it
 * alone. All return 1, or 0 with every output untouched when F is not admissible: J <= 0 where the model
 * needs J > 0, F not finite, a result that overflows, an unknown model or a NULL pointer. */

/* *W = elastic energy per reference volume [J/m^3]. */
SB_API int sb_material_energy(const sb_material *material, const sb_mat3 *F, sb_quat *rotation, sb_real *W);
/* *P = dW/dF, first Piola-Kirchhoff stress [Pa]: force per reference area, P N = traction. */
SB_API int sb_material_stress(const sb_material *material, const sb_mat3 *F, sb_quat *rotation, sb_mat3 *P);
/* A[9*(3*i+j) + (3*k+l)] = dP_ij/dF_kl [Pa], 81 values, exactly symmetric.
 *
 * The corotated models' energy has a kink where the rotation is not unique, at s_2 + s_3 = 0 for principal
 * stretches s_1 >= s_2 >= |s_3|: there the exact tangent is infinite. A divides by s_i + s_j, but never by
 * less than 1e-6 max(1, s_1 + s_2 + s_3), so it stays finite; SB_TANGENT_SPD likewise. SB_TANGENT_QUASI does
 * not divide by it. */
SB_API int sb_material_tangent(const sb_material *material, const sb_mat3 *F, sb_quat *rotation,
                               sb_tangent_kind kind, sb_real A[81]);

/* Cauchy stress P F^T/J [Pa]: force per current area. Not finite when J = 0. */
SB_API sb_mat3 sb_cauchy_stress(sb_mat3 F, sb_mat3 P);
/* The same for a material's P; P itself for SB_LINEAR: small strain does not tell the stresses apart. */
SB_API sb_mat3 sb_material_cauchy_stress(const sb_material *material, sb_mat3 F, sb_mat3 P);
/* Von Mises equivalent sqrt(3/2 s:s) [Pa], s the deviator of a symmetric stress. */
SB_API sb_real sb_von_mises(sb_mat3 sigma);

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* ==== internal: shares of a material =====================================================================
 * Every hyperelastic energy here is linear in its moduli, so that a share of a material is a material. */

/* The share of a material that a B-bar element evaluates at each of its points, and the one at its mean point:
 * W = W_shear + W_volume, with mu (and fibres) in the first, lambda in the second; isochoric models: psi and U. */
typedef enum sbi_material_share { SBI_SHARE_WHOLE, SBI_SHARE_SHEAR, SBI_SHARE_VOLUME } sbi_material_share;
SBI_API sb_material sbi_material_share_of(const sb_material *material, sbi_material_share share);

/* What Prony terms relax: everything in proportion to the shear modulus at a constant bulk modulus (isochoric
 * models: psi), fibres included. Only its stress means anything: its lambda is -2 mu/3. */
SBI_API sb_material sbi_material_relaxing(const sb_material *material);
/* The material with its relaxing share times a: bulk modulus as before. */
SBI_API sb_material sbi_material_relaxed(const sb_material *material, sb_real a);
/* a(dt) = g_inf + sum g_i gamma_i, gamma_i = (1 - exp(-x_i))/x_i, x_i = dt/tau_i: the share of a new stress that is
 * left at the end of the step of dt (s) in which it comes about evenly. 1 for dt = 0, g_inf for dt infinite. */
SBI_API sb_real sbi_prony_factor(const sb_material *material, sb_real dt);
/* gamma_i, and exp(-x_i) in *decay. */
SBI_API sb_real sbi_prony_term(const sb_material *material, int term, sb_real dt, sb_real *decay);
#endif

/* ==== internal: workers of one model =====================================================================
 * Callers pass an F that is finite; a NaN comes out as NaN. Formula names: f_i is row i of F, I1 = F:F,
 * B = F^-T = cof(F)/J. Tangents are written by 3x3 blocks (i,k) with entries (j,l) = dP_ij/dF_kl. */

/* Row i of a. */
SBI_FORCE_INLINE sb_vec3 sbi_material_row(const sb_mat3 *a, int i)
{
    return sb_v3(a->m[i][0], a->m[i][1], a->m[i][2]);
}

/* 1 when the symmetric a is positive definite (Sylvester's leading minors). */
SBI_FORCE_INLINE int sbi_material_is_positive(sb_mat3 a)
{
    return a.m[0][0] > 0 && a.m[0][0] * a.m[1][1] - a.m[0][1] * a.m[0][1] > 0 && sb_m3_det(a) > 0;
}

/* scale a + shift I */
SBI_FORCE_INLINE sb_mat3 sbi_material_affine(sb_real scale, sb_mat3 a, sb_real shift)
{
    a = sb_m3_scale(scale, a);
    for (int i = 0; i < 3; i++)
        a.m[i][i] += shift;
    return a;
}

/* Writes block (i,k) and its mirror image (k,i); i <= k. */
SBI_FORCE_INLINE void sbi_tangent_put(sb_real *A, int i, int k, sb_mat3 block)
{
    for (int j = 0; j < 3; j++)
        for (int l = 0; l < 3; l++) {
            A[9 * (3 * i + j) + 3 * k + l] = block.m[j][l];
            A[9 * (3 * k + l) + 3 * i + j] = block.m[j][l];
        }
}

/* A += weight d (x) d, exactly symmetric. */
SB_INLINE void sbi_tangent_add_dyad(sb_real *A, sb_real weight, sb_mat3 d)
{
    for (int p = 0; p < 9; p++) {
        sb_real scaled = weight * d.m[p / 3][p % 3];
        for (int q = p; q < 9; q++)
            A[9 * p + q] = A[9 * q + p] = A[9 * p + q] + scaled * d.m[q / 3][q % 3];
    }
}

/* ---- linear ---- */

SBI_FORCE_INLINE sb_mat3 sbi_linear_strain(const sb_mat3 *F)
{
    sb_mat3 e;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            e.m[i][j] = (sb_real)0.5 * (F->m[i][j] + F->m[j][i]) - (sb_real)(i == j);
    return e;
}

/* lambda tr(e) I + 2 mu e */
SBI_FORCE_INLINE sb_mat3 sbi_hooke_stress(const sb_material *m, sb_mat3 e)
{
    sb_mat3 s = sb_m3_scale(2 * m->mu, e);
    sb_real pressure = m->lambda * sb_m3_trace(e);
    for (int i = 0; i < 3; i++)
        s.m[i][i] += pressure;
    return s;
}

/* lambda/2 tr(e)^2 + mu e:e */
SBI_FORCE_INLINE sb_real sbi_hooke_energy(const sb_material *m, sb_mat3 e)
{
    sb_real trace = sb_m3_trace(e);
    return (sb_real)0.5 * m->lambda * trace * trace + m->mu * sb_m3_ddot(e, e);
}

/* ---- corotated ---- */

/* What the corotated models take from F = R S: R; s and V of F = U diag(s) V^T in the signed-SVD variant. */
typedef struct sbi_corotation {
    sb_mat3 r;
    sb_vec3 s;
    sb_mat3 v;
} sbi_corotation;

SBI_FORCE_INLINE sbi_corotation sbi_corotate(const int model, const sb_mat3 *F, sb_quat *rotation)
{
    sbi_corotation c;
    if (model == SB_COROTATED_INVERTIBLE) {
        sb_mat3 u;
        sb_m3_svd(*F, &u, &c.s, &c.v);
        c.r = sb_m3_mult(u, c.v);
    } else {
        sb_quat q = sb_m3_polar(*F, rotation ? *rotation : sb_quat_identity());
        c.r = sb_quat_to_mat3(q);
        if (rotation)
            *rotation = q;
        c.s = sb_v3(0, 0, 0); /* found only where it is needed */
        c.v = sb_m3_zero();
    }
    return c;
}

/* 2 mu (F - R) + lambda (tr(R^T F) - 3) R */
SBI_FORCE_INLINE sb_mat3 sbi_corotated_stress(const sb_material *m, const sb_mat3 *F, const sb_mat3 *r)
{
    sb_real pressure = m->lambda * (sb_m3_ddot(*r, *F) - 3);
    return sb_m3_add(sb_m3_scale(2 * m->mu, *F), sb_m3_scale(pressure - 2 * m->mu, *r));
}

SBI_FORCE_INLINE sb_real sbi_corotated_energy(const sb_material *m, const sb_mat3 *F, const sb_mat3 *r)
{
    sb_mat3 d = sb_m3_sub(*F, *r);
    sb_real trace = sb_m3_ddot(*r, *F) - 3;
    return m->mu * sb_m3_ddot(d, d) + (sb_real)0.5 * m->lambda * trace * trace;
}

/* The corotated tangent is Hooke's, rotated, plus the share of the rotation's change,
 *     A = R C R^T + sum_cd Z_cd (R [e_c]x) (x) (R [e_d]x),   Z = mu I + kappa G^-1,
 * with G = tr(S) I - S and kappa = lambda tr(S - I) - 2 mu. Z has the eigenvectors v_k of S and the values
 * mu + kappa/(s_i + s_j) (half of tau_ij), {i,j,k} = {0,1,2}: the twist eigenvalues of A. */

/* Lower bound of s_i + s_j; F is 1 at rest, so the scale of stretches is max(1, their sum). */
SBI_FORCE_INLINE sb_real sbi_spin_least(sb_real trace) { return (sb_real)1e-6 * sb_max(1, trace); }

/* Z from the eigen-decomposition S = V diag(s) V^T. */
SB_INLINE sb_mat3 sbi_spin_from_stretches(sb_real mu, sb_real kappa, sb_vec3 s, sb_mat3 v,
                                          sb_tangent_kind kind)
{
    sb_real least = sbi_spin_least(s.x + s.y + s.z), z[3];
    sb_mat3 spin;
    z[0] = mu + kappa / sb_max(s.y + s.z, least);
    z[1] = mu + kappa / sb_max(s.x + s.z, least);
    z[2] = mu + kappa / sb_max(s.x + s.y, least);
    if (kind != SB_TANGENT_EXACT)
        for (int k = 0; k < 3; k++)
            z[k] = sb_max(z[k], 0);
    for (int i = 0; i < 3; i++)
        for (int j = i; j < 3; j++)
            spin.m[i][j] = spin.m[j][i] =
                z[0] * v.m[i][0] * v.m[j][0] + z[1] * v.m[i][1] * v.m[j][1] + z[2] * v.m[i][2] * v.m[j][2];
    return spin;
}

/* Z from S itself: without an eigen-decomposition unless values of both signs are to be clamped, or the
 * rotation is nearly not unique. */
SB_INLINE sb_mat3 sbi_spin_from_stretch(sb_real mu, sb_real kappa, sb_mat3 stretch, sb_tangent_kind kind)
{
    sb_real trace = sb_m3_trace(stretch);
    sb_mat3 g = sbi_material_affine(-1, stretch, trace);
    /* The two largest eigenvalues of G multiply to at most trace^2, so the third is >= det/trace^2. */
    if (sbi_material_is_positive(g) && sb_m3_det(g) > sbi_spin_least(trace) * trace * trace) {
        sb_mat3 scaled = sbi_material_affine(mu, g, kappa); /* G Z, of the same signs as Z */
        if (kind == SB_TANGENT_EXACT || kappa >= 0 || sbi_material_is_positive(scaled))
            return sbi_material_affine(kappa, sb_m3_inverse(g), mu);
        if (sbi_material_is_positive(sb_m3_scale(-1, scaled)))
            return sb_m3_zero();
    }
    sb_vec3 s;
    sb_mat3 v;
    sb_m3_eigen(stretch, &s, &v);
    return sbi_spin_from_stretches(mu, kappa, s, v, kind);
}

/* sym(R^T F) */
SBI_FORCE_INLINE sb_mat3 sbi_corotated_stretch(const sb_mat3 *F, const sb_mat3 *r)
{
    sb_mat3 s = sb_m3_tmul(*r, *F);
    for (int i = 0; i < 3; i++)
        for (int j = i + 1; j < 3; j++)
            s.m[i][j] = s.m[j][i] = (sb_real)0.5 * (s.m[i][j] + s.m[j][i]);
    return s;
}

/* [r]x m: column c is r x (column c of m). */
SBI_FORCE_INLINE sb_mat3 sbi_spin_cross(sb_vec3 r, sb_mat3 m)
{
    return sb_m3_columns(sb_v3_cross(r, sb_m3_column(m, 0)), sb_v3_cross(r, sb_m3_column(m, 1)),
                         sb_v3_cross(r, sb_m3_column(m, 2)));
}

/* Block (i,k) = lambda r_i r_k^T + mu r_k r_i^T + delta_ik mu I + [r_i]x Z [r_k]x^T with the rows r of R. */
SBI_FORCE_INLINE void sbi_corotated_assemble(const sb_material *m, sb_mat3 r, const sb_mat3 *spin, sb_real *A)
{
    for (int i = 0; i < 3; i++) {
        sb_vec3 ri = sbi_material_row(&r, i);
        sb_mat3 left = spin ? sb_m3_transpose(sbi_spin_cross(ri, *spin)) : sb_m3_zero();
        for (int k = i; k < 3; k++) {
            sb_vec3 rk = sbi_material_row(&r, k);
            sb_mat3 block = sb_m3_add(sb_m3_outer(ri, sb_v3_scale(m->lambda, rk)),
                                      sb_m3_outer(sb_v3_scale(m->mu, rk), ri));
            if (i == k)
                block = sbi_material_affine(1, block, m->mu);
            if (spin)
                block = sb_m3_add(block, sb_m3_transpose(sbi_spin_cross(rk, left)));
            sbi_tangent_put(A, i, k, block);
        }
    }
}

SBI_FORCE_INLINE void sbi_corotated_tangent(const int model, const sb_material *m, const sb_mat3 *F,
                                            sb_quat *rotation, const sb_tangent_kind kind, sb_real *A)
{
    sbi_corotation c = sbi_corotate(model, F, rotation);
    sb_real kappa;
    sb_mat3 spin;
    if (kind == SB_TANGENT_QUASI) {
        sbi_corotated_assemble(m, c.r, NULL, A);
        return;
    }
    kappa = m->lambda * (sb_m3_ddot(c.r, *F) - 3) - 2 * m->mu;
    if (model == SB_COROTATED_INVERTIBLE)
        spin = sbi_spin_from_stretches(m->mu, kappa, c.s, c.v, kind);
    else
        spin = sbi_spin_from_stretch(m->mu, kappa, sbi_corotated_stretch(F, &c.r), kind);
    sbi_corotated_assemble(m, c.r, &spin, A);
}

/* Hooke's tangent: the rotated one at R = I. */
SBI_FORCE_INLINE void sbi_linear_tangent(const sb_material *m, sb_real *A)
{
    sbi_corotated_assemble(m, sb_m3_identity(), NULL, A);
}

/* ---- St.Venant-Kirchhoff ---- */

/* E = (F^T F - I)/2 */
SBI_FORCE_INLINE sb_mat3 sbi_green_strain(const sb_mat3 *F)
{
    return sbi_material_affine((sb_real)0.5, sb_m3_tmul(*F, *F), -(sb_real)0.5);
}

/* Block (i,k) = lambda f_i f_k^T + mu f_k f_i^T + mu (f_i.f_k) I + delta_ik S */
SBI_FORCE_INLINE void sbi_svk_tangent(const sb_material *m, const sb_mat3 *F, sb_real *A)
{
    sb_mat3 s = sbi_hooke_stress(m, sbi_green_strain(F));
    for (int i = 0; i < 3; i++) {
        sb_vec3 fi = sbi_material_row(F, i);
        for (int k = i; k < 3; k++) {
            sb_vec3 fk = sbi_material_row(F, k);
            sb_mat3 block = sb_m3_add(sb_m3_outer(fi, sb_v3_scale(m->lambda, fk)),
                                      sb_m3_outer(sb_v3_scale(m->mu, fk), fi));
            block = sbi_material_affine(1, block, m->mu * sb_v3_dot(fi, fk));
            sbi_tangent_put(A, i, k, i == k ? sb_m3_add(block, s) : block);
        }
    }
}

/* ---- neo-Hookean with a volume barrier: ln J and isochoric form ---- */

/* Both forms have P = alpha F - epsilon B and
 *     A_ijkl = alpha d_ik d_jl + beta (F_ij B_kl + B_ij F_kl) + gamma B_ij B_kl + epsilon B_il B_kj. */
typedef struct sbi_barrier {
    sb_mat3 b;
    sb_real J, alpha, beta, gamma, epsilon;
} sbi_barrier;

SBI_FORCE_INLINE int sbi_barrier_at(const int model, const sb_material *m, const sb_mat3 *F, sbi_barrier *out)
{
    sb_mat3 cofactor = sb_m3_cofactor(*F);
    sb_real J = sb_v3_dot(sb_m3_column(*F, 0), sb_m3_column(cofactor, 0));
    if (!(J > 0))
        return 0;
    out->J = J;
    out->b = sb_m3_scale(1 / J, cofactor);
    if (model == SB_NEO_HOOKEAN) {
        out->alpha = m->mu;
        out->beta = 0;
        out->gamma = m->lambda;
        out->epsilon = m->mu - m->lambda * sb_log(J);
    } else {
        sb_real root = sb_cbrt(J), I1 = sb_m3_ddot(*F, *F), stiffness = 2 * J / m->d1; /* J U'' */
        out->alpha = 2 * m->c10 / (root * root);
        out->beta = -(sb_real)2 / 3 * out->alpha;
        out->gamma = (sb_real)2 / 9 * out->alpha * I1 + stiffness * (2 * J - 1);
        out->epsilon = out->alpha * I1 / 3 - stiffness * (J - 1);
    }
    return 1;
}

SBI_FORCE_INLINE int sbi_barrier_stress(const int model, const sb_material *m, const sb_mat3 *F, sb_mat3 *P)
{
    sbi_barrier c;
    if (!sbi_barrier_at(model, m, F, &c))
        return 0;
    *P = sb_m3_sub(sb_m3_scale(c.alpha, *F), sb_m3_scale(c.epsilon, c.b));
    return 1;
}

SBI_FORCE_INLINE int sbi_barrier_energy(const int model, const sb_material *m, const sb_mat3 *F, sb_real *W)
{
    sb_real J = sb_m3_det(*F), I1 = sb_m3_ddot(*F, *F);
    if (!(J > 0))
        return 0;
    if (model == SB_NEO_HOOKEAN) {
        sb_real log_J = sb_log(J);
        *W = (sb_real)0.5 * m->mu * (I1 - 3) + ((sb_real)0.5 * m->lambda * log_J - m->mu) * log_J;
    } else {
        sb_real root = sb_cbrt(J);
        *W = m->c10 * (I1 / (root * root) - 3) + (J - 1) * (J - 1) / m->d1;
    }
    return 1;
}

SBI_FORCE_INLINE int sbi_barrier_tangent(const int model, const sb_material *m, const sb_mat3 *F, sb_real *A)
{
    sbi_barrier c;
    if (!sbi_barrier_at(model, m, F, &c))
        return 0;
    for (int i = 0; i < 3; i++) {
        sb_vec3 bi = sbi_material_row(&c.b, i);
        sb_vec3 fi = sbi_material_row(F, i);
        for (int k = i; k < 3; k++) {
            sb_vec3 bk = sbi_material_row(&c.b, k), right = sb_v3_scale(c.gamma, bk);
            if (model != SB_NEO_HOOKEAN) /* beta = 0 there */
                right = sb_v3_madd(right, c.beta, sbi_material_row(F, k));
            sb_mat3 block = sb_m3_add(sb_m3_outer(bi, right), sb_m3_outer(sb_v3_scale(c.epsilon, bk), bi));
            if (model != SB_NEO_HOOKEAN)
                block = sb_m3_add(block, sb_m3_outer(fi, sb_v3_scale(c.beta, bk)));
            sbi_tangent_put(A, i, k, i == k ? sbi_material_affine(1, block, c.alpha) : block);
        }
    }
    return 1;
}

/* ---- stable neo-Hookean ---- */

/* mu F + ((lambda + mu)(J - 1) - mu) cof F: polynomial in F, so J <= 0 is nothing special. */
SBI_FORCE_INLINE sb_mat3 sbi_stable_stress(const sb_material *m, const sb_mat3 *F)
{
    sb_mat3 cofactor = sb_m3_cofactor(*F);
    sb_real J = sb_v3_dot(sb_m3_column(*F, 0), sb_m3_column(cofactor, 0));
    return sb_m3_add(sb_m3_scale(m->mu, *F), sb_m3_scale((m->lambda + m->mu) * (J - 1) - m->mu, cofactor));
}

SBI_FORCE_INLINE sb_real sbi_stable_energy(const sb_material *m, const sb_mat3 *F)
{
    sb_real growth = sb_m3_det(*F) - 1;
    return (sb_real)0.5 * m->mu * (sb_m3_ddot(*F, *F) - 3) +
           ((sb_real)0.5 * (m->lambda + m->mu) * growth - m->mu) * growth;
}

/* Block (i,k) = delta_ik mu I + (lambda + mu) c_i c_k^T + q e_ikn [f_n]x^T, c_i the rows of cof F,
 * q = (lambda + mu)(J - 1) - mu; the last part is d cof_ij/dF_kl = e_ikn e_jlp F_np. */
SBI_FORCE_INLINE void sbi_stable_tangent(const sb_material *m, const sb_mat3 *F, sb_real *A)
{
    sb_mat3 c = sb_m3_cofactor(*F);
    sb_real stiffness = m->lambda + m->mu;
    sb_real J = sb_v3_dot(sb_m3_column(*F, 0), sb_m3_column(c, 0)), q = stiffness * (J - 1) - m->mu;
    for (int i = 0; i < 3; i++) {
        sb_vec3 ci = sb_v3_scale(stiffness, sbi_material_row(&c, i));
        for (int k = i; k < 3; k++) {
            sb_mat3 block = sb_m3_outer(ci, sbi_material_row(&c, k));
            if (i == k) {
                block = sbi_material_affine(1, block, m->mu);
            } else {
                int n = 3 - i - k;
                sb_real signed_q = k == i + 1 ? q : -q; /* e_ikn for i < k */
                for (int j = 0; j < 3; j++) {
                    int l = (j + 1) % 3, p = (j + 2) % 3;
                    block.m[j][l] += signed_q * F->m[n][p];
                    block.m[l][j] -= signed_q * F->m[n][p];
                }
            }
            sbi_tangent_put(A, i, k, block);
        }
    }
}

/* ---- positive semidefinite projection of the hyperelastic tangents ---- */

/* 1 when the symmetric 9x9 A is positive semidefinite to rounding (L D L^T with the pivots in order). */
SB_INLINE int sbi_tangent_is_semidefinite(const sb_real *A)
{
    sb_real lower[9][9], largest = 0, tolerance;
    for (int r = 0; r < 9; r++) {
        largest = sb_max(largest, A[10 * r]);
        for (int c = 0; c <= r; c++)
            lower[r][c] = A[9 * r + c];
    }
    tolerance = 32 * SB_EPSILON * largest;
    for (int c = 0; c < 9; c++) {
        sb_real pivot = lower[c][c];
        if (pivot > tolerance) {
            for (int r = c + 1; r < 9; r++) {
                sb_real factor = lower[r][c] / pivot;
                for (int q = c + 1; q <= r; q++)
                    lower[r][q] -= factor * lower[q][c];
            }
            continue;
        }
        /* A zero pivot belongs to a semidefinite matrix only when its whole column is zero. */
        if (!(pivot >= -tolerance))
            return 0;
        for (int r = c + 1; r < 9; r++)
            if (!(sb_abs(lower[r][c]) <= tolerance))
                return 0;
    }
    return 1;
}

/* A between principal directions, F = U diag(s) V^T: in that frame only A_iijj = stretch[i][j] and,
 * with m the third index of the pair (i,j), A_ijij = same[m] and A_ijji = cross[m] are not 0. */
typedef struct sbi_principal {
    sb_mat3 stretch;
    sb_real same[3], cross[3];
} sbi_principal;

SB_INLINE void sbi_principal_svk(const sb_material *m, const sb_real *s, sbi_principal *out)
{
    sb_real squares = s[0] * s[0] + s[1] * s[1] + s[2] * s[2];
    sb_real pressure = (sb_real)0.5 * m->lambda * (squares - 3);
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        out->stretch.m[i][i] = (m->lambda + 3 * m->mu) * s[i] * s[i] + pressure - m->mu;
        out->stretch.m[j][k] = out->stretch.m[k][j] = m->lambda * s[j] * s[k];
        out->same[i] = pressure + m->mu * (s[j] * s[j] + s[k] * s[k] - 1);
        out->cross[i] = m->mu * s[j] * s[k];
    }
}

/* Divides by J, which is known to be positive, where a stretch may have been rounded to 0. */
SB_INLINE void sbi_principal_barrier(const sbi_barrier *c, const sb_real *s, sbi_principal *out)
{
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        sb_real inverse = s[j] * s[k] / c->J, product = s[i] / c->J; /* 1/s_i and 1/(s_j s_k) */
        out->stretch.m[i][i] = c->alpha + 2 * c->beta + (c->gamma + c->epsilon) * inverse * inverse;
        out->stretch.m[j][k] = out->stretch.m[k][j] =
            (c->beta * (s[j] * s[j] + s[k] * s[k]) + c->gamma) * product;
        out->same[i] = c->alpha;
        out->cross[i] = c->epsilon * product;
    }
}

SB_INLINE void sbi_principal_stable(const sb_material *m, const sb_real *s, sbi_principal *out)
{
    sb_real stiffness = m->lambda + m->mu, q = stiffness * (s[0] * s[1] * s[2] - 1) - m->mu;
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        out->stretch.m[i][i] = m->mu + stiffness * s[j] * s[j] * s[k] * s[k];
        out->stretch.m[j][k] = out->stretch.m[k][j] = stiffness * s[i] * s[i] * s[j] * s[k] + q * s[i];
        out->same[i] = m->mu;
        out->cross[i] = -q * s[i];
    }
}

/* The principal form of a hyperelastic model's tangent; F is admissible. */
SBI_FORCE_INLINE void sbi_principal_at(const int model, const sb_material *m, const sb_mat3 *F,
                                       const sb_real *s, sbi_principal *out)
{
    sbi_barrier c;
    if (model == SB_SVK)
        sbi_principal_svk(m, s, out);
    else if (model == SB_STABLE_NEO_HOOKEAN)
        sbi_principal_stable(m, s, out);
    else if (sbi_barrier_at(model, m, F, &c))
        sbi_principal_barrier(&c, s, out);
}

/* Lifts the negative eigenvalues of the scaling modes sum_c e_c u_c v_c^T, e the eigenvectors of stretch. */
SB_INLINE void sbi_tangent_lift_scaling(sb_mat3 stretch, sb_mat3 u, sb_mat3 v, sb_real *A)
{
    sb_vec3 values;
    sb_mat3 modes;
    sb_m3_eigen(stretch, &values, &modes);
    const sb_real scaling[3] = {values.x, values.y, values.z};
    for (int k = 0; k < 3; k++) {
        sb_mat3 scaled = u;
        if (!(scaling[k] < 0))
            continue;
        for (int c = 0; c < 3; c++)
            for (int r = 0; r < 3; r++)
                scaled.m[r][c] *= modes.m[c][k];
        sbi_tangent_add_dyad(A, -scaling[k], sb_m3_mult(scaled, v));
    }
}

/* Lifts the negative eigenvalues of A to 0. A's eigenvectors are the scaling modes above, and for each
 * pair (i,j) u_i v_j^T - u_j v_i^T with same - cross (twist) and u_i v_j^T + u_j v_i^T with same + cross
 * (flip). These equal (g_i +- g_j)/(s_i +- s_j) with the division done by hand, so equal stretches need no
 * care (Smith et al. 2019). */
SB_INLINE void sbi_tangent_lift(const sbi_principal *principal, sb_mat3 u, sb_mat3 v, sb_real *A)
{
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        sb_mat3 ij = sb_m3_outer(sb_m3_column(u, i), sb_m3_column(v, j));
        sb_mat3 ji = sb_m3_outer(sb_m3_column(u, j), sb_m3_column(v, i));
        sb_real twist = principal->same[k] - principal->cross[k];
        sb_real flip = principal->same[k] + principal->cross[k];
        if (twist < 0)
            sbi_tangent_add_dyad(A, -(sb_real)0.5 * twist, sb_m3_sub(ij, ji));
        if (flip < 0)
            sbi_tangent_add_dyad(A, -(sb_real)0.5 * flip, sb_m3_add(ij, ji));
    }
    if (!sbi_material_is_positive(principal->stretch))
        sbi_tangent_lift_scaling(principal->stretch, u, v, A);
}

/* Projects the exact tangent A of a hyperelastic model at F; decomposes F only where A needs it. */
SBI_FORCE_INLINE void sbi_tangent_project(const int model, const sb_material *m, const sb_mat3 *F, sb_real *A)
{
    if (sbi_tangent_is_semidefinite(A))
        return;
    sb_mat3 u, v;
    sb_vec3 stretches;
    sbi_principal principal;
    sb_m3_svd(*F, &u, &stretches, &v);
    const sb_real s[3] = {stretches.x, stretches.y, stretches.z};
    sbi_principal_at(model, m, F, s, &principal);
    sbi_tangent_lift(&principal, u, v, A);
}

/* ---- the workers; `model` is a literal where speed counts ---- */

SBI_FORCE_INLINE int sbi_material_energy_inline(const int model, const sb_material *m, const sb_mat3 *F,
                                                sb_quat *rotation, sb_real *W)
{
    switch (model) {
    case SB_LINEAR: *W = sbi_hooke_energy(m, sbi_linear_strain(F)); return 1;
    case SB_COROTATED:
    case SB_COROTATED_INVERTIBLE: {
        sbi_corotation c = sbi_corotate(model, F, rotation);
        *W = sbi_corotated_energy(m, F, &c.r);
        return 1;
    }
    case SB_SVK: *W = sbi_hooke_energy(m, sbi_green_strain(F)); return 1;
    case SB_NEO_HOOKEAN:
    case SB_NEO_HOOKEAN_ISOCHORIC: return sbi_barrier_energy(model, m, F, W);
    case SB_STABLE_NEO_HOOKEAN: *W = sbi_stable_energy(m, F); return 1;
    default: return 0;
    }
}

SBI_FORCE_INLINE int sbi_material_stress_inline(const int model, const sb_material *m, const sb_mat3 *F,
                                                sb_quat *rotation, sb_mat3 *P)
{
    switch (model) {
    case SB_LINEAR: *P = sbi_hooke_stress(m, sbi_linear_strain(F)); return 1;
    case SB_COROTATED:
    case SB_COROTATED_INVERTIBLE: {
        sbi_corotation c = sbi_corotate(model, F, rotation);
        *P = sbi_corotated_stress(m, F, &c.r);
        return 1;
    }
    case SB_SVK: *P = sb_m3_mul(*F, sbi_hooke_stress(m, sbi_green_strain(F))); return 1;
    case SB_NEO_HOOKEAN:
    case SB_NEO_HOOKEAN_ISOCHORIC: return sbi_barrier_stress(model, m, F, P);
    case SB_STABLE_NEO_HOOKEAN: *P = sbi_stable_stress(m, F); return 1;
    default: return 0;
    }
}

SBI_FORCE_INLINE int sbi_material_tangent_inline(const int model, const sb_material *m, const sb_mat3 *F,
                                                 sb_quat *rotation, const sb_tangent_kind kind, sb_real *A)
{
    switch (model) {
    case SB_LINEAR: sbi_linear_tangent(m, A); return 1;
    case SB_COROTATED:
    case SB_COROTATED_INVERTIBLE: sbi_corotated_tangent(model, m, F, rotation, kind, A); return 1;
    case SB_SVK: sbi_svk_tangent(m, F, A); break;
    case SB_NEO_HOOKEAN:
    case SB_NEO_HOOKEAN_ISOCHORIC:
        if (!sbi_barrier_tangent(model, m, F, A))
            return 0;
        break;
    case SB_STABLE_NEO_HOOKEAN: sbi_stable_tangent(m, F, A); break;
    default: return 0;
    }
    if (kind != SB_TANGENT_EXACT)
        sbi_tangent_project(model, m, F, A);
    return 1;
}

#endif /* SB_MATERIAL_H */

/* ==== src/softbody/sparse.h ==== */
/* sparse: square 3x3 block matrices with a symmetric pattern, their products and constraints. Floor 1. */
#ifndef SB_SPARSE_H
#define SB_SPARSE_H


/* Bits of a node's constraint mask: which of its displacement components are prescribed. */
enum { SB_X = 1, SB_Y = 2, SB_Z = 4, SB_XYZ = 7 };

/* A square matrix of 3x3 blocks in compressed rows: block q of row i (row_start[i] <= q < row_start[i + 1])
 * couples node i with node columns[q]. Columns ascend in each row, the diagonal block is always there, and
 * for every block (i, j) there is a block (j, i): the pattern is symmetric and stored whole.
 *
 * Whole storage costs twice the memory of one triangle, but then a row of a product has one writer: rows can
 * be shared among threads and the sums keep their order, so the bits do not depend on the thread count. */
typedef struct sb_matrix {
    int row_count; /* nodes */
    int block_count;
    int *row_start;       /* [row_count + 1] */
    int *columns;         /* [block_count] */
    int *diagonal;        /* [row_count] position of block (i, i) */
    int *transpose;       /* [block_count] position of block (j, i) for the block (i, j) */
    unsigned char *fixed; /* [row_count] mask of the last sb_matrix_constrain; 0: free */
    sb_real (*blocks)[9]; /* [block_count] row-major, 64-byte aligned, with one sb_real to spare at the end */
    void *memory;         /* the one allocation behind all arrays */
    sb_allocator allocator;
} sb_matrix;

/* Makes the matrix whose nodes are coupled when they share a cell (an element, a particle's neighbours ...);
 * all values are zero. Nodes without a cell keep their diagonal block.
 * node_count      number of nodes, >= 1
 * cell_count      number of cells, >= 0
 * nodes_per_cell  nodes of each cell, >= 1; ignored when cell_start is given
 * cell_start      [cell_count + 1] first entry of each cell in `cells`, ascending from 0; NULL: fixed size
 * cells           node indices of the cells; a node may repeat within a cell
 * allocator       NULL: malloc
 * Returns SB_ERROR_ARGUMENT, SB_ERROR_INDEX (error->element is the cell) or SB_ERROR_MEMORY (also when there
 * would be more than 2^31-1 blocks) with *matrix untouched. Release with sb_matrix_free. Time and scratch
 * memory are proportional to the cells' node pairs. */
SB_API sb_result sb_matrix_create(int node_count, int cell_count, int nodes_per_cell, const int *cell_start,
                                  const int *cells, const sb_allocator *allocator, sb_matrix *matrix,
                                  sb_error *error);

/* Releases the arrays and zeroes the struct; a zeroed matrix is fine. */
SB_API void sb_matrix_free(sb_matrix *matrix);

/* Sets all values to zero and clears the constraint mask. */
SB_API void sb_matrix_clear(sb_matrix *matrix);

/* Position of block (i, j), or -1 when the pattern has none or an index is out of range. Time O(log row). */
SB_API int sb_matrix_find(const sb_matrix *matrix, int i, int j);

/* y = A x; x and y are [row_count][3] and must not overlap. jobs NULL: inline. */
SB_API void sb_matrix_multiply(const sb_matrix *matrix, const sb_real *x, sb_real *y, const sb_jobs *jobs);

/* Largest |A_ij - A_ji| divided by the largest |A_ij|; 0 for a zero matrix, NaN when an entry is. */
SB_API sb_real sb_matrix_asymmetry(const sb_matrix *matrix);

/* Mean of |A_kk| over the free scalar rows (mask NULL: all), the scale given to constrained ones; 1 when
 * there are none or all are zero, not finite when an entry is not. */
SB_API sb_real sb_matrix_diagonal_scale(const sb_matrix *matrix, const unsigned char *mask);

/* Replaces the equations of prescribed components by s x_k = s value_k, s = sb_matrix_diagonal_scale, keeping
 * symmetry: the known terms move to the right-hand side, rhs -= A[:, k] value_k, before rows and columns k
 * are zeroed.
 * mask    [row_count] SB_X | SB_Y | SB_Z; copied into matrix->fixed
 * values  [row_count][3] prescribed values, read where the mask says so; NULL: all zero
 * rhs     [row_count][3] changed in place; NULL: only the matrix is changed
 * Needs a symmetric matrix; touches the constrained rows and their transposed blocks only. The diagonal stays
 * as large as its neighbours so that neither the condition number nor a relative residual notices the
 * replaced rows. */
SB_API void sb_matrix_constrain(sb_matrix *matrix, const unsigned char *mask, const sb_real *values,
                                sb_real *rhs);

/* ---- internal ------------------------------------------------------------------------------------------ */

/* Four reals as one vector where compiler and processor have them (doubles without AVX do not): memory is
 * read at any alignment. Code with SBI_HAS_LANES has a plain form beside it that gives the same bits;
 * SB_NO_VECTORS asks for that one. */
#if defined(__GNUC__) && !defined(SB_NO_VECTORS) && (defined(__AVX__) || SB_REAL_IS_FLOAT)
#define SBI_HAS_LANES 1
typedef sb_real sbi_lanes
    __attribute__((vector_size(4 * sizeof(sb_real)), aligned(sizeof(sb_real)), may_alias));
#define SBI_LANES_AT(pointer) (*(const sbi_lanes *)(const void *)(pointer))
#define SBI_LANES_PUT(pointer, value) (*(sbi_lanes *)(void *)(pointer) = (value))
#else
#define SBI_HAS_LANES 0
#endif

/* Rows per task of products and vector loops: fixed, so that partial sums do not depend on threads. */
enum { SBI_ROW_CHUNK = 512 };

SB_INLINE int sbi_row_chunks(int row_count)
{
    return row_count / SBI_ROW_CHUNK + (row_count % SBI_ROW_CHUNK != 0);
}

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* y_i = (A x)_i for the rows first <= i < last. */
SBI_API void sbi_matrix_multiply_rows(const sb_matrix *matrix, const sb_real *x, sb_real *y, int first,
                                      int last);
#endif

#endif /* SB_SPARSE_H */

/* ==== src/softbody/precond.h ==== */
/* precond: preconditioners for block matrices: block Jacobi, SSOR, incomplete Cholesky, each with a coarse
 * space of rigid motions. Floor 2. */
#ifndef SB_PRECOND_H
#define SB_PRECOND_H


/* What smooths: z = M^-1 r of one application. */
typedef enum sb_precond_kind {
    SB_PRECOND_NONE = 0,         /* z = r */
    SB_PRECOND_BLOCK_JACOBI = 1, /* inverse 3x3 diagonal blocks; cheapest set-up, most iterations */
    SB_PRECOND_SSOR = 2,         /* symmetric over-relaxation; nearly no set-up, cannot break down */
    SB_PRECOND_IC0 = 3,          /* block incomplete Cholesky on the matrix's pattern; fewest iterations */
    SB_PRECOND_AUTO = 4          /* the library's choice: SB_PRECOND_IC0 */
} sb_precond_kind;

enum { SB_PRECOND_PIECES_AUTO = -1 };

typedef struct sb_preconditioner_def {
    sb_precond_kind kind;     /* default SB_PRECOND_AUTO */
    const sb_vec3 *positions; /* [row_count] (m), read at creation only; NULL (default): no coarse space */
    int piece_count; /* rigid pieces of the coarse space, >= 0; 0: none; default SB_PRECOND_PIECES_AUTO */
} sb_preconditioner_def;

/* What a preconditioner resolved to and how its last update went. */
typedef struct sb_preconditioner_info {
    sb_precond_kind kind; /* never SB_PRECOND_AUTO */
    int piece_count;      /* rigid pieces in use, 0: no coarse space */
    int attempts;         /* factorisations tried by the last update (IC0); 0 before the first */
    double shift;         /* IC0: the diagonal was multiplied by 1 + shift to keep the pivots positive */
    size_t bytes;         /* memory held */
} sb_preconditioner_info;

/* The preconditioner of one matrix pattern. The smoother works in single precision: it only has to point the
 * right way, and it is memory that limits its speed.
 *
 * The coarse space. Smoothers are blind to motions that vary slowly over the mesh, and those are what gravity
 * and a tool cause. So the nodes are cut into compact pieces, each free to move rigidly (6 unknowns), and the
 * piece motions Q = Z (Z^T A Z)^-1 Z^T are solved exactly around every smoothing:
 *     z = S r + Q (r - A S r)          [A-DEF2 of Tang, Nabben, Vuik, Erlangga 2009]
 * On a slender beam this divides the iterations by five for the price of a small dense system. PCG's first
 * residual has to satisfy Z^T r = 0, which sb_pcg_solve sees to. */
typedef struct sb_preconditioner sb_preconditioner;

/* The defaults named at the fields. */
SB_API sb_preconditioner_def sb_default_preconditioner_def(void);

/* Makes a preconditioner for matrices of this pattern (values are not read) with all memory it ever needs.
 * allocator NULL: malloc. *out is released with sb_preconditioner_free and refers to neither def nor pattern.
 * Returns SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE (a position, error->node) or SB_ERROR_MEMORY; *out stays. */
SB_API sb_result sb_preconditioner_create(const sb_preconditioner_def *def, const sb_matrix *pattern,
                                          const sb_allocator *allocator, sb_preconditioner **out,
                                          sb_error *error);
SB_API void sb_preconditioner_free(sb_preconditioner *preconditioner);

/* Takes over the values of a symmetric matrix of the pattern; allocates nothing.
 * positions  [row_count] where the nodes are now, for the rigid motions of the pieces; NULL: as before
 * Returns SB_ERROR_ARGUMENT (another pattern), SB_ERROR_NOT_FINITE, or SB_ERROR_INDEFINITE when a diagonal
 * block is not positive definite or no diagonal shift up to 65.536 makes the incomplete factor exist. After an
 * error the preconditioner must be updated again before use.
 * An IC0 that breaks down starts again with a larger diagonal (at most 17 times), keeps that shift for the
 * following updates, and after a run of successful ones tries half of it. */
SB_API sb_result sb_preconditioner_update(sb_preconditioner *preconditioner, const sb_matrix *matrix,
                                          const sb_vec3 *positions, sb_error *error);

/* z = M^-1 r; both [row_count][3], not overlapping. Uses the preconditioner's scratch: one call at a time. */
SB_API void sb_preconditioner_apply(sb_preconditioner *preconditioner, const sb_real *r, sb_real *z);

SB_API sb_preconditioner_info sb_preconditioner_get_info(const sb_preconditioner *preconditioner);

/* ---- internal ------------------------------------------------------------------------------------------ */

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* As sb_preconditioner_apply when |r| is known (any value of the magnitude of r's entries, not 0): r is
 * brought near 1 before it is rounded to single precision, so that tiny residuals do not vanish. */
SBI_API void sbi_precond_apply(sb_preconditioner *preconditioner, const sb_real *r, sb_real *z, double size);
/* z = Q r: the part of the solution that the coarse space sees. Without one: returns 0, z untouched. */
SBI_API int sbi_precond_coarse_solve(sb_preconditioner *preconditioner, const sb_real *r, sb_real *z,
                                     double size);
/* Rows of the pattern it was made for. */
SBI_API int sbi_precond_rows(const sb_preconditioner *preconditioner);
#endif

#endif /* SB_PRECOND_H */

/* ==== src/softbody/pcg.h ==== */
/* pcg: preconditioned conjugate gradients. Floor 2. */
#ifndef SB_PCG_H
#define SB_PCG_H


typedef struct sb_pcg_options {
    double tolerance; /* stop when |rhs - A x| <= tolerance |rhs|, >= 0; default 1e-6 (float builds: 1e-3) */
    int max_iterations;  /* bound of the work, >= 0; default 1000 */
    const sb_jobs *jobs; /* NULL (default): inline; the result is the same for any number of threads */
} sb_pcg_options;

typedef struct sb_pcg_info {
    int iterations;         /* products with A in search directions */
    double residual;        /* |rhs - A x| / |rhs| of the returned x */
    int residual_is_true;   /* 1: computed from x; 0: by the recurrence, which drifts by epsilon |A| |x| */
    int negative_curvature; /* 1: a direction with p.Ap <= 0 ended the solve: A is not positive definite */
    int capped;             /* 1: max_iterations ended the solve */
} sb_pcg_info;

/* Vectors of one solve, to be kept between solves. Not for two solves at a time. */
typedef struct sb_pcg_workspace {
    int row_count;
    sb_real *start, *residual, *search, *direction, *product; /* [row_count][3] */
    double *partial;                                          /* [chunks][2] sums of each chunk of rows */
    void *memory;
    sb_allocator allocator;
} sb_pcg_workspace;

/* The defaults named at the fields. */
SB_API sb_pcg_options sb_default_pcg_options(void);

/* Takes the vectors for systems of row_count >= 1 nodes. SB_ERROR_ARGUMENT or SB_ERROR_MEMORY leave
 * *workspace untouched. Release with sb_pcg_workspace_free. allocator NULL: malloc. */
SB_API sb_result sb_pcg_workspace_create(int row_count, const sb_allocator *allocator,
                                         sb_pcg_workspace *workspace, sb_error *error);
SB_API void sb_pcg_workspace_free(sb_pcg_workspace *workspace);

/* Solves A x = rhs for a symmetric positive definite A.
 * preconditioner  up to date with A; NULL: none
 * rhs             [row_count][3]
 * x               [row_count][3] in: the start; out: the solution. rhs = 0 gives x = 0 whatever the start
 * options         NULL: defaults
 * info            filled in every case but SB_ERROR_ARGUMENT; may be NULL
 * Returns SB_OK;
 *   SB_ERROR_NOT_CONVERGED  the cap was reached, or rounding stops progress (info->capped tells which); x is
 *                           the last
 *                           iterate, good enough for a real-time step that had no time for more
 *   SB_ERROR_INDEFINITE     p.Ap <= 0 (info->negative_curvature) or a preconditioner that is not positive
 *                           definite;
 *                           x is the last iterate before
 *   SB_ERROR_DIVERGED       a NaN or infinity, in the input or grown; x is the start again
 *   SB_ERROR_ARGUMENT       sizes that do not match, options out of range; x untouched
 * Tolerances whose cube is below SB_EPSILON are near what the recurrence can hold: there the true residual is
 * computed at the end, and the iteration goes on from it if it has drifted. No x of sb_real can have a
 * smaller residual than about SB_EPSILON |A| |x|: in float builds that is 1e-4 |rhs| for a soft beam of 2,000
 * nodes. Sums are taken in double over fixed chunks of rows, added in order: same bits for any number of
 * threads. */
SB_API sb_result sb_pcg_solve(const sb_matrix *matrix, sb_preconditioner *preconditioner, const sb_real *rhs,
                              sb_real *x, const sb_pcg_options *options, sb_pcg_workspace *workspace,
                              sb_pcg_info *info);

#endif /* SB_PCG_H */

/* ==== src/softbody/domain.h ==== */
/* domain: integration points, the one abstraction everything with energy is made of. Floor 2. */
#ifndef SB_DOMAIN_H
#define SB_DOMAIN_H


/* Cells of integration points. A cell is a list of nodes and the points that share it; a point is a weight (m^3)
 * and the reference gradients (1/m) of the cell's shape functions. With these
 *     F = I + sum_a u_a (x) grad N_a,   f_a += w P grad N_a,   K_ab += w grad N_a . dP/dF . grad N_b
 * serve every element, and whatever else can name its nodes, weights and gradients. */
typedef struct sb_domain {
    sb_element_type element_type; /* what the cells are; lets loops run with literal counts */
    int single_rotation;          /* 1: one rotation per cell, from its corners (tet10) */
    int node_count;
    int cell_count;
    int nodes_per_cell;
    int points_per_cell;
    int *cells;                   /* [cell_count][nodes_per_cell] */
    sb_real *gradients;           /* [cell_count][points_per_cell][nodes_per_cell][3]  (1/m) */
    sb_real *weights;             /* [cell_count][points_per_cell]  (m^3) */
    sb_real *corner_gradients;    /* [cell_count][4][3] of the straight corner tet (1/m), or NULL */
    sb_allocator allocator;
} sb_domain;

/* How a domain integrates its elements. */
typedef enum sb_integration {
    SB_INTEGRATION_AUTO = 0,   /* standard; tet10 with curved sides gets the 8-point rule it needs */
    SB_INTEGRATION_STANDARD = 1, /* tet4 1, tet10 4, hex8 2x2x2 points */
    SB_INTEGRATION_CURVED = 2  /* tet10 8 points (degree 3); other elements as standard */
} sb_integration;

/* Makes the domain of a volume mesh's elements. single_rotation: 1 for tet10 with one rotation per element.
 * Fails with SB_ERROR_MESH naming the element when a Jacobian at an integration point is not positive,
 * SB_ERROR_NOT_FINITE or SB_ERROR_INDEX naming the node, SB_ERROR_ARGUMENT for a surface mesh or single_rotation on
 * another element, SB_ERROR_UNSUPPORTED for an element that SB_ELEMENT left out, SB_ERROR_MEMORY; *domain is then
 * untouched. Release with sb_domain_free. Source: formula of the isoparametric map, g_a = Je^-T dN_a/dxi. */
SB_API sb_result sb_domain_create(const sb_mesh *mesh, sb_integration integration, int single_rotation,
                                  const sb_allocator *allocator, sb_domain *domain, sb_error *error);

/* Releases the arrays and leaves zeros; {0} is fine. */
SB_API void sb_domain_free(sb_domain *domain);

/* Mass matrices of an element at unit density. */
typedef enum sb_mass_kind {
    SB_MASS_LUMPED = 0,     /* diagonal, positive: HRZ scaling of the consistent diagonal (Hinton et al. 1976) */
    SB_MASS_CONSISTENT = 1, /* int N_a N_b dV, integrated exactly */
    SB_MASS_REDUCED = 2     /* int N_a N_b dV with the points of the stiffness, as some industrial solvers do. Of low
                             * rank on tets: for comparisons, with supports */
} sb_mass_kind;

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* mass[nodes][nodes] (m^3) of the element with nodes at x[nodes] (m); lumped masses stand on the diagonal.
 * Multiply by the density. volume_load[nodes] (m^3), may be NULL: int N_a dV, exact. */
SBI_API void sbi_element_mass(sb_element_type type, sb_mass_kind kind, const sb_vec3 *x, sb_real *mass,
                              sb_real *volume_load);
#endif

#endif /* SB_DOMAIN_H */

/* ==== src/softbody/body.h ==== */
/* body: a mesh with material, supports, loads and state. Floor 3. */
#ifndef SB_BODY_H
#define SB_BODY_H


/* Functions that return an sb_result refuse a NULL body; the others need one. */
typedef struct sb_body sb_body;

/* Means "let the library choose" where a def or an option says so. */
enum { SB_AUTO = -1 };

typedef enum sb_integrator {
    SB_EULER = 1,  /* implicit Euler: first order, damps; for trainers */
    SB_NEWMARK = 2, /* average acceleration (beta 1/4, gamma 1/2): second order, keeps the energy of linear bodies; for
                    * studies. Large motions without damping have no bound on their energy: keep dt small, add some */
    SB_GENERALISED_ALPHA = 3, /* Chung and Hulbert 1993: second order, damps what dt cannot resolve and nothing else;
                               * for large or fast motions. spectral_radius says how much */
    SB_CENTRAL_DIFFERENCE = 4 /* explicit: no linear systems, cheap substeps of at most sb_body_stable_step. Second
                               * order. Lumped mass and damping_mass only */
} sb_integrator;

/* The material of one region of the mesh. */
typedef struct sb_region_material {
    int region;           /* value in mesh.regions */
    sb_material material;
} sb_region_material;

/* What a body is made from. Start from sb_default_body_def(), set mesh and material, change what you like. */
typedef struct sb_body_def {
    const sb_mesh *mesh;              /* volume mesh (m); read during sb_body_create only */
    sb_material material;             /* of every region that region_materials does not name */
    const sb_region_material *region_materials; /* [region_material_count] or NULL */
    int region_material_count;
    sb_integration integration;       /* integration points per element; default SB_INTEGRATION_AUTO */
    int single_rotation;              /* 1: tet10 with one rotation per element (corotated only); default 0 */
    sb_mass_kind mass;                /* default SB_MASS_LUMPED */
    sb_integrator integrator;         /* of sb_body_step; default SB_EULER */
    sb_real spectral_radius;          /* SB_GENERALISED_ALPHA: what a step leaves of the highest frequencies, [0, 1];
                                       * 1 damps nothing, 0 kills them in one step; default 0.5. A soft
                                       * beam falling about its clamp with large steps: Newmark and 0.8 gain energy
                                       * without bound, 0.5 and less gain none */
    int max_substeps;                 /* SB_CENTRAL_DIFFERENCE: most substeps of one sb_body_step, >= 1; default 10000 */
    sb_vec3 gravity;                  /* m/s^2; default 0 */
    sb_real damping_mass;             /* Rayleigh alpha (1/s), >= 0; default 0 */
    sb_real damping_stiffness;        /* Rayleigh beta (s), >= 0; default 0 */
    sb_precond_kind preconditioner;   /* default SB_PRECOND_AUTO */
    sb_real tolerance;                /* of a linearised step's solve, |r| / |b|, in (0, 1); default 1e-3. Iterated steps
                                       * choose theirs from newton_tolerance */
    int max_iterations;               /* of a step's linear solve; bounds a frame's time; default 500 */
    int max_newton;                   /* Newton iterations per step: 1 is the linearised step of real-time work;
                                       * SB_AUTO (default): 1 for linear and, with Euler, corotated; 20 otherwise */
    sb_real newton_tolerance;         /* relative residual of a step with several iterations; default 1e-6 */
    sb_allocator allocator;           /* default malloc */
    sb_jobs jobs;                     /* default inline */
    sb_clock clock;                   /* for sb_step_info's times; default NULL */
    unsigned cookie;                  /* set by sb_default_body_def; a def made without it is refused */
} sb_body_def;

SB_API sb_body_def sb_default_body_def(void);

/* Creates a body at rest in the mesh's shape. All memory that stepping needs is taken here. On failure *body is
 * untouched and the error says what is wrong: SB_ERROR_ARGUMENT and SB_ERROR_NOT_FINITE (field or node named),
 * SB_ERROR_MESH (element named), SB_ERROR_INDEX (node index, or a region that the mesh does not have),
 * SB_ERROR_MATERIAL, SB_ERROR_UNSUPPORTED (element left out by SB_ELEMENT), SB_ERROR_MEMORY. Destroy with sb_body_destroy. */
SB_API sb_result sb_body_create(const sb_body_def *def, sb_body **body, sb_error *error);
SB_API void sb_body_destroy(sb_body *body); /* NULL is fine */

/* ---- sizes ---- */
SB_API int sb_body_node_count(const sb_body *body);
SB_API int sb_body_element_count(const sb_body *body);
SB_API int sb_body_point_count(const sb_body *body); /* integration points per element */
SB_API int sb_body_matrix_blocks(const sb_body *body); /* stored 3x3 blocks of the tangent */

/* ---- properties: may change between steps ----
 * Each checks its arguments first and changes nothing on failure. A material may allocate when it is the first whose
 * steps take several iterations (SB_ERROR_MEMORY). */
SB_API sb_result sb_body_set_material(sb_body *body, const sb_material *material, sb_error *error); /* all regions */
SB_API sb_result sb_body_set_region_material(sb_body *body, int region, const sb_material *material,
                                             sb_error *error);
SB_API sb_result sb_body_set_gravity(sb_body *body, sb_vec3 gravity);
/* SB_ERROR_UNSUPPORTED: beta > 0 with SB_CENTRAL_DIFFERENCE. */
SB_API sb_result sb_body_set_damping(sb_body *body, sb_real alpha, sb_real beta);
/* Tolerance in (0, 1) and cap (>= 1) of a step's linear solve. */
SB_API sb_result sb_body_set_solver(sb_body *body, sb_real tolerance, int max_iterations);

/* ---- supports ----
 * A supported degree of freedom follows its target displacement (from the reference shape); a step moves it there
 * exactly. axes is a sum of SB_X (1), SB_Y (2), SB_Z (4), SB_XYZ all three. nodes[count] are node indices; SB_ERROR_INDEX names the first that is out of range. May allocate (to
 * remember the support rows of the tangent): SB_ERROR_MEMORY leaves the supports as they were. */
/* Holds the given axes where the nodes are now. */
SB_API sb_result sb_body_fix_nodes(sb_body *body, const int *nodes, int count, int axes);
/* Supports the axes and sets their targets: displacements[count] (m), or one for all when uniform is 1. */
SB_API sb_result sb_body_prescribe(sb_body *body, const int *nodes, int count, int axes,
                                   const sb_vec3 *displacements, int uniform);
/* Frees the axes; their velocity stays. */
SB_API sb_result sb_body_release_nodes(sb_body *body, const int *nodes, int count, int axes);
/* Supported axes of every node as bits, [node_count]. */
SB_API const unsigned char *sb_body_supports(const sb_body *body);

/* ---- loads: dead loads that stay until cleared ---- */
/* Adds forces[count] (N), or one for all when uniform is 1, to the nodes. */
SB_API sb_result sb_body_add_forces(sb_body *body, const int *nodes, int count, const sb_vec3 *forces, int uniform);
/* Adds a traction (Pa on undeformed area) on element faces, each given by its 3 (tet) or 4 (hex) corner nodes in
 * any order: faces[face_count][corners]. SB_ERROR_ARGUMENT names the first face that no element has. */
SB_API sb_result sb_body_add_traction(sb_body *body, const int *faces, int face_count, int corners,
                                      sb_vec3 traction, sb_error *error);
SB_API void sb_body_clear_loads(sb_body *body); /* forces and tractions; gravity stays */

/* ---- state ---- */
SB_API const sb_vec3 *sb_body_positions(const sb_body *body);     /* [node_count] (m), valid until destroyed */
SB_API const sb_vec3 *sb_body_displacements(const sb_body *body); /* [node_count] (m) */
SB_API const sb_vec3 *sb_body_velocities(const sb_body *body);    /* [node_count] (m/s) */
/* Overwrites the state (any finite values, inside-out shapes included); SB_ERROR_NOT_FINITE changes nothing. What comes
 * after agrees with the original run up to rounding, not to the last bit: solver warm starts are not part of it. */
SB_API sb_result sb_body_set_displacements(sb_body *body, const sb_vec3 *displacements);
SB_API sb_result sb_body_set_velocities(sb_body *body, const sb_vec3 *velocities);
/* Back to the reference shape at rest; supports, loads and materials stay. */
SB_API void sb_body_reset(sb_body *body);

/* ---- readings: no allocation ---- */
/* Force (N) of the supports on the body, per node, 0 on free axes, of the last step or static solve; with the
 * loads it balances the rate of momentum. At the end of the step; with SB_GENERALISED_ALPHA where that scheme has its
 * balance, a share 1/(1 + spectral_radius) of the way through it (at the end where it had to take 0). [node_count], valid until the next solve. */
SB_API const sb_vec3 *sb_body_reactions(const sb_body *body);
/* All loads of the last solve (gravity, forces, tractions) as nodal forces (N), [node_count]. */
SB_API const sb_vec3 *sb_body_external_forces(const sb_body *body);
/* SB_ERROR_INVERTED or SB_ERROR_NOT_FINITE (too large for sb_real) leave *energy untouched. */
typedef struct sb_energy {
    sb_real elastic;    /* J */
    sb_real kinetic;    /* J */
} sb_energy;
SB_API sb_result sb_body_energy(sb_body *body, sb_energy *energy);
/* Total mass (kg) and momentum (kg m/s). */
SB_API sb_real sb_body_mass(const sb_body *body);
SB_API sb_vec3 sb_body_momentum(const sb_body *body);
/* Cauchy stress (Pa) at an integration point of an element, from the current state. SB_ERROR_INDEX,
 * SB_ERROR_INVERTED (material has no stress there); *stress is then untouched. */
SB_API sb_result sb_body_stress(const sb_body *body, int element, int point, sb_mat3 *stress);
/* Von Mises stress (Pa) of every element, mean over its points, 0 where there is none; values[element_count]. */
SB_API void sb_body_von_mises(const sb_body *body, sb_real *values);
/* The same as nodal averages weighted by volume, for colouring; values[node_count]. */
SB_API void sb_body_nodal_von_mises(const sb_body *body, sb_real *values);

/* ---- set-up check ---- */
/* What looks wrong, as bits of sb_check_report.warnings. */
enum {
    SB_CHECK_SIZE = 1,           /* bounding box over 10 m or under 1 mm: units? */
    SB_CHECK_DENSITY = 2,        /* a density outside 100 .. 10,000 kg/m^3: units? */
    SB_CHECK_STIFFNESS = 4,      /* a Young's modulus outside 10 Pa .. 10 MPa: not soft tissue, units? */
    SB_CHECK_SLIVERS = 8,        /* elements of quality under 0.1 */
    SB_CHECK_LOCKING = 16,       /* Poisson's ratio above 0.49 on tet4 or hex8, which lock: use tet10 */
    SB_CHECK_UNREFERENCED = 32,  /* nodes that belong to no element; held in place */
    SB_CHECK_UNSUPPORTED = 64,   /* a part whose supports leave rigid motions free: no static solve */
    SB_CHECK_COMPONENTS = 128,   /* more than one connected part */
    SB_CHECK_DUPLICATES = 256    /* elements with the same corners as another: their mass and stiffness count twice */
};
typedef struct sb_check_report {
    unsigned warnings;           /* SB_CHECK_ bits; 0: nothing suspicious */
    sb_real size;                /* diagonal of the bounding box (m) */
    sb_real worst_quality;       /* of any element, 1 is regular */
    int worst_element;
    int sliver_count;
    int unreferenced_count;
    int component_count;
    int duplicate_count;
    int unsupported_component_node; /* a node of the first unsupported part, or -1 */
} sb_check_report;
SB_API sb_result sb_body_check(const sb_body *body, sb_check_report *report);
/* One sentence about one SB_CHECK_ bit; never NULL. */
SB_API const char *sb_check_string(unsigned warning);

#endif /* SB_BODY_H */

/* ==== src/softbody/step.h ==== */
/* step: time steps and static solves of a body. Floor 3. */
#ifndef SB_STEP_H
#define SB_STEP_H


/* What a step or a static solve did. Every field is written by every call, failed ones too. */
typedef struct sb_step_info {
    int newton_iterations;    /* linear systems solved; an iteration whose exact tangent fails solves two */
    int pcg_iterations;       /* of all of them together */
    int substeps;             /* SB_CENTRAL_DIFFERENCE: explicit steps taken; otherwise 0 */
    int load_steps;           /* static: load increments that converged; a time step: 1 */
    sb_real load_factor;      /* static: share of load and prescribed motion carried, 1 when done */
    sb_real residual;         /* out-of-balance force relative to the largest force, at the last check; a linearised
                               * step (max_newton 1): |b - A x| / |b| of its linear solve */
    int capped;               /* 1: an iteration cap was hit and the best state so far was taken */
    double seconds_force;     /* with a clock, otherwise 0: rotations and internal forces, */
    double seconds_tangent;   /* assembly, */
    double seconds_precond;   /* preconditioner set-up, */
    double seconds_solve;     /* conjugate gradients, */
    double seconds_total;     /* and the whole call */
    sb_error error;           /* result, message, element or node when the call failed */
} sb_step_info;

/* Advances the body by dt (s, > 0) with its integrator. Supports reach their targets exactly.
 *
 * With max_newton 1 the step is linearised (one system, Baraff and Witkin 1998): its cost is bounded and the
 * result is taken even when max_iterations cut the linear solve short (info->capped). With more iterations each is
 * followed by a line search on the step's potential, which also refuses inverted elements for materials that have
 * no energy there.
 *
 * SB_CENTRAL_DIFFERENCE takes dt in equal substeps of at most 0.9 stable steps, as many as that needs; the stable step
 * is found anew every 16 substeps as the body deforms. Substeps that go bad all the same (an element inverted, more
 * energy than came in) are taken back, and the call is done again with shorter ones, up to three times.
 *
 * info may be NULL. On failure (SB_ERROR_ARGUMENT, SB_ERROR_INVERTED naming the element, SB_ERROR_DIVERGED,
 * SB_ERROR_INDEFINITE, SB_ERROR_NOT_CONVERGED naming the stable step: more than max_substeps) positions, velocities, accelerations and reactions are as before the call and the body can
 * go on, to the last bit as if the call had not been. Allocates nothing. Formulas: implicit Euler and Newmark in the increment du,
 *     (ca M + cv D + K) du = f_ext - f_int - M a0 - D v0,  D = alpha M + beta K;
 * generalised alpha the same with u at the time of its balance, from which the end of the step is extrapolated. Where
 * the material does not admit that end, the step is done again with spectral radius 0, whose balance is at the end.
 * Central difference:
 *     u' = u + h v + h^2/2 a,  (M + h/2 D) a' = f_ext - f_int(u') - D (v + h/2 a),  v' = v + h/2 (a + a'). */
SB_API sb_result sb_body_step(sb_body *body, sb_real dt, sb_step_info *info);

/* *dt (s) = the longest step that is sure to be stable under SB_CENTRAL_DIFFERENCE at the present shape with the
 * lumped mass, 2/omega_max from a bound of omega_max that is never below it: typically 0.8 to 0.99 of the true limit.
 * Mass damping does not change it; supports are left out of account. Works for bodies of any integrator and leaves
 * their state as it is. Costs an assembly of the tangent and some products with it; allocates nothing. On failure
 * (SB_ERROR_ARGUMENT, SB_ERROR_INVERTED naming the element, SB_ERROR_NOT_FINITE) *dt is untouched; error may be NULL.
 * Bound: max over rows of (|K| x)_i / (m_i x_i) for a positive x (Collatz 1942, Wielandt 1950), x by iteration. */
SB_API sb_result sb_body_stable_step(sb_body *body, sb_real *dt, sb_error *error);

/* How a static solve goes about its work. Start from sb_default_static_options(). */
typedef struct sb_static_options {
    int load_steps;           /* equal increments to begin with, >= 1; they grow and shrink as Newton converges;
                               * default 1 */
    sb_real tolerance;        /* |out-of-balance force| / largest of load and reaction, (0, 1); default 1e-6; what is
                               * below 64 epsilon counts as that */
    int max_newton;           /* iterations per increment before it is halved, >= 1; default 30. Bodies with a single
                               * rotation per element converge linearly and take at least 300 */
    int max_iterations;       /* of each linear solve, >= 1; default 20000 */
    int keep_progress;        /* 1: on failure the body stays at the last converged increment; 0 (default): it
                               * returns to where it was */
    void (*progress)(void *user, const sb_step_info *info); /* after each increment, or NULL */
    void *progress_user;
    unsigned cookie;          /* set by sb_default_static_options */
} sb_static_options;

SB_API sb_static_options sb_default_static_options(void);

/* Finds the equilibrium under the present loads and supports: Newton with the exact tangent, projected to positive
 * definite where it is not, a line search that refuses inverted elements, and adaptive load increments from the
 * loads of the last static solve (0 at first) and the present shape. Velocities become 0. options NULL: defaults.
 *
 * Errors: SB_ERROR_UNCONSTRAINED names a node of a part that can move freely; SB_ERROR_INVERTED names the element
 * that would turn inside out; SB_ERROR_DIVERGED, SB_ERROR_NOT_CONVERGED after halving the increment six times. */
SB_API sb_result sb_body_solve_static(sb_body *body, const sb_static_options *options, sb_step_info *info);

#endif /* SB_STEP_H */

/* ==== src/softbody/modes.h ==== */
/* modes: natural frequencies and mode shapes of a body. Floor 3. */
#ifndef SB_MODES_H
#define SB_MODES_H


/* How modes are looked for. Start from sb_default_modes_options(). */
typedef struct sb_modes_options {
    sb_mass_kind mass;        /* mass matrix, whatever the body moves with; default SB_MASS_CONSISTENT */
    int at_present;           /* 0 (default): small motions about the undeformed shape without stress; 1: about the
                               * present shape with its exact tangent, stresses included */
    sb_real tolerance;        /* |K x - lambda M x| / lambda in the norm of M^-1, for x of unit mass, (0, 1); default
                               * 1e-8, which makes the error of a frequency far smaller. What is below rounding in K x
                               * counts as that */
    int max_iterations;       /* times the space that is searched may grow, >= 1; default 100 */
    unsigned cookie;          /* set by sb_default_modes_options */
} sb_modes_options;

SB_API sb_modes_options sb_default_modes_options(void);

/* What a search did; written on success and on SB_ERROR_NOT_CONVERGED. */
typedef struct sb_modes_info {
    int iterations;           /* times the space grew */
    int solves;               /* linear systems */
    int pcg_iterations;       /* of all of them together */
    sb_real residual;         /* the largest of any mode, as the tolerance measures it */
    double seconds;           /* with the body's clock, otherwise 0 */
} sb_modes_info;

/* Finds the lowest `count` natural frequencies of the body with its supports (at rest where they are).
 * count        1 .. degrees of freedom that no support holds
 * options      NULL: defaults
 * frequencies  [count] (Hz), ascending, multiple ones as often as they are; rigid motions that the supports leave come
 *              out as about 0 (rounding of K x), never as NaN
 * shapes       [count][node_count] or NULL: displacements x (m) of unit modal mass, x^T M x = 1 kg m^2, at right
 *              angles in M; 0 at supported axes
 * info, error  may be NULL
 * Takes memory for about 2 count + 40 vectors from the body's allocator for the time of the call. The body's state is
 * left as it is, to the last bit; loads play no part.
 * Errors: SB_ERROR_ARGUMENT, SB_ERROR_MEMORY, SB_ERROR_INVERTED (at_present, naming the element), SB_ERROR_INDEFINITE
 * (the present shape is not stable: it buckles), SB_ERROR_NOT_CONVERGED naming the mode; frequencies and shapes are
 * then untouched.
 * Method: Rayleigh-Ritz in a space that grows by (K + shift M)^-1 r of the residuals r of the lowest modes not yet
 * found, from random vectors (block Davidson; Parlett 1998, 11 and 13); systems by PCG, loosely. */
SB_API sb_result sb_body_modes(sb_body *body, int count, const sb_modes_options *options, sb_real *frequencies,
                               sb_vec3 *shapes, sb_modes_info *info, sb_error *error);

#endif /* SB_MODES_H */

#endif /* SOFTBODY_H */

#if defined(SB_IMPLEMENTATION) && !defined(SB_IMPLEMENTATION_DONE)
#define SB_IMPLEMENTATION_DONE

/* ==== src/softbody/core.c ==== */
/* core: results, checked sizes, allocation, jobs. */

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

SB_API const char *sb_result_string(sb_result result)
{
    switch (result) {
    case SB_OK: return "SB_OK";
    case SB_ERROR_MEMORY: return "SB_ERROR_MEMORY";
    case SB_ERROR_ARGUMENT: return "SB_ERROR_ARGUMENT";
    case SB_ERROR_NOT_FINITE: return "SB_ERROR_NOT_FINITE";
    case SB_ERROR_INDEX: return "SB_ERROR_INDEX";
    case SB_ERROR_FILE: return "SB_ERROR_FILE";
    case SB_ERROR_FORMAT: return "SB_ERROR_FORMAT";
    case SB_ERROR_UNSUPPORTED: return "SB_ERROR_UNSUPPORTED";
    case SB_ERROR_MESH: return "SB_ERROR_MESH";
    case SB_ERROR_MATERIAL: return "SB_ERROR_MATERIAL";
    case SB_ERROR_UNCONSTRAINED: return "SB_ERROR_UNCONSTRAINED";
    case SB_ERROR_INVERTED: return "SB_ERROR_INVERTED";
    case SB_ERROR_DIVERGED: return "SB_ERROR_DIVERGED";
    case SB_ERROR_NOT_CONVERGED: return "SB_ERROR_NOT_CONVERGED";
    case SB_ERROR_INDEFINITE: return "SB_ERROR_INDEFINITE";
    }
    return "unknown sb_result";
}

/* ---- errors ---- */

static void sbi_error_clear(sb_error *error, sb_result result)
{
    memset(error, 0, sizeof *error);
    error->result = result;
    error->element = -1;
    error->node = -1;
}

SBI_API sb_result sbi_fail(sb_error *error, sb_result result, const char *format, ...)
{
    if (error) {
        va_list arguments;
        va_start(arguments, format);
        sbi_error_clear(error, result);
        vsnprintf(error->message, sizeof error->message, format, arguments);
        va_end(arguments);
    }
    return result;
}

SBI_API sb_result sbi_fail_element(sb_error *error, sb_result result, int element, const char *format, ...)
{
    if (error) {
        va_list arguments;
        va_start(arguments, format);
        sbi_error_clear(error, result);
        error->element = element;
        vsnprintf(error->message, sizeof error->message, format, arguments);
        va_end(arguments);
    }
    return result;
}

SBI_API sb_result sbi_fail_node(sb_error *error, sb_result result, int node, const char *format, ...)
{
    if (error) {
        va_list arguments;
        va_start(arguments, format);
        sbi_error_clear(error, result);
        error->node = node;
        vsnprintf(error->message, sizeof error->message, format, arguments);
        va_end(arguments);
    }
    return result;
}

/* ---- memory ---- */

SBI_API int sbi_size_add(size_t *total, size_t count, size_t size)
{
    if (size && count > ((size_t)-1 - *total) / size)
        return 0;
    *total += count * size;
    return 1;
}

SBI_API void *sbi_alloc(const sb_allocator *allocator, size_t count, size_t size)
{
    size_t bytes = 0;
    if (!sbi_size_add(&bytes, count, size))
        return NULL;
    if (bytes == 0)
        bytes = 1;
    if (allocator && allocator->alloc)
        return allocator->alloc(allocator->user, bytes);
    return malloc(bytes);
}

SBI_API void *sbi_alloc_zeroed(const sb_allocator *allocator, size_t count, size_t size)
{
    void *pointer = sbi_alloc(allocator, count, size);
    if (pointer)
        memset(pointer, 0, count * size);
    return pointer;
}

SBI_API void sbi_free(const sb_allocator *allocator, void *pointer)
{
    if (!pointer)
        return;
    if (allocator && allocator->alloc)
        allocator->release(allocator->user, pointer);
    else
        free(pointer);
}

SBI_API void *sbi_arena_take(sbi_arena *arena, size_t count, size_t size)
{
    size_t start = arena->used, end = start;
    if (!sbi_size_add(&end, count, size) || end > (size_t)-1 - 63) {
        arena->overflow = 1;
        return NULL;
    }
    arena->used = (end + 63) & ~(size_t)63;
    return arena->base ? arena->base + start : NULL;
}

/* ---- jobs ---- */

SBI_API void sbi_run(const sb_jobs *jobs, sb_task task, void *task_user, int count)
{
    if (jobs && jobs->run && count > 1) {
        jobs->run(jobs->user, task, task_user, count);
        return;
    }
    for (int i = 0; i < count; i++)
        task(task_user, i);
}

#if defined(SB_USE_OPENMP)
static void sbi_openmp_run(void *user, sb_task task, void *task_user, int count)
{
    (void)user;
#pragma omp parallel for schedule(dynamic, 1)
    for (int i = 0; i < count; i++)
        task(task_user, i);
}

SB_API sb_jobs sb_jobs_openmp(void)
{
    sb_jobs jobs;
    jobs.run = sbi_openmp_run;
    jobs.user = NULL;
    return jobs;
}
#endif

/* ==== src/softbody/element.c ==== */
/* element: tables of faces and edges, shape functions, quadrature. */

/* ---- names, faces, edges ---- */

SB_API const char *sb_element_name(sb_element_type type)
{
    switch (type) {
    case SB_TRI3: return "tri3";
    case SB_TRI6: return "tri6";
    case SB_QUAD4: return "quad4";
    case SB_TET4: return "tet4";
    case SB_TET10: return "tet10";
    case SB_HEX8: return "hex8";
    case SB_NO_ELEMENT: break;
    }
    return "unknown";
}

/* Outward faces; the first three columns are the faces of tet4. */
static const signed char sbi_element_tet_faces[4][6] = {
    {0, 1, 3, 4, 8, 7}, {1, 2, 3, 5, 9, 8}, {2, 0, 3, 6, 7, 9}, {0, 2, 1, 6, 5, 4}};
static const signed char sbi_element_hex_faces[6][4] = {{0, 4, 7, 3}, {1, 2, 6, 5}, {0, 1, 5, 4},
                                                        {3, 7, 6, 2}, {0, 3, 2, 1}, {4, 5, 6, 7}};

/* Ends of the edges; mid-edge nodes follow the corners in the order of the edges. */
static const signed char sbi_element_tri_edges[3][2] = {{0, 1}, {1, 2}, {2, 0}};
static const signed char sbi_element_quad_edges[4][2] = {{0, 1}, {1, 2}, {2, 3}, {3, 0}};
static const signed char sbi_element_tet_edges[6][2] = {{0, 1}, {1, 2}, {0, 2}, {0, 3}, {1, 3}, {2, 3}};
static const signed char sbi_element_hex_edges[12][2] = {{0, 1}, {1, 2}, {2, 3}, {3, 0}, {4, 5}, {5, 6},
                                                         {6, 7}, {7, 4}, {0, 4}, {1, 5}, {2, 6}, {3, 7}};

static const signed char (*sbi_element_edges(sb_element_type type))[2]
{
    switch (type) {
    case SB_TRI3:
    case SB_TRI6: return sbi_element_tri_edges;
    case SB_QUAD4: return sbi_element_quad_edges;
    case SB_TET4:
    case SB_TET10: return sbi_element_tet_edges;
    case SB_HEX8: return sbi_element_hex_edges;
    case SB_NO_ELEMENT: break;
    }
    return NULL;
}

SB_API int sb_element_face(sb_element_type type, int face, int nodes[SB_MAX_FACE_NODES],
                           sb_element_type *face_type)
{
    if (face < 0 || face >= sb_element_face_count(type))
        return 0;
    sb_element_type of_face = type == SB_HEX8 ? SB_QUAD4 : (type == SB_TET10 ? SB_TRI6 : SB_TRI3);
    int count = sb_element_node_count(of_face);
    for (int i = 0; i < count; i++)
        nodes[i] = type == SB_HEX8 ? sbi_element_hex_faces[face][i] : sbi_element_tet_faces[face][i];
    if (face_type)
        *face_type = of_face;
    return count;
}

SB_API int sb_element_edge(sb_element_type type, int edge, int nodes[3])
{
    if (edge < 0 || edge >= sb_element_edge_count(type))
        return 0;
    int corners = sb_element_corner_count(type);
    int quadratic = sb_element_node_count(type) > corners;
    nodes[0] = sbi_element_edges(type)[edge][0];
    nodes[1] = sbi_element_edges(type)[edge][1];
    nodes[2] = quadratic ? corners + edge : -1;
    return quadratic ? 3 : 2;
}

/* ---- shape functions ---- */

/* Corners of quad4 (first four, without z) and hex8. */
static const signed char sbi_element_hex_corners[8][3] = {{-1, -1, -1}, {1, -1, -1}, {1, 1, -1}, {-1, 1, -1},
                                                          {-1, -1, 1},  {1, -1, 1},  {1, 1, 1},  {-1, 1, 1}};

SB_API int sb_element_node_point(sb_element_type type, int node, sb_real xi[3])
{
    int corners = sb_element_corner_count(type), dimension = sb_element_dimension(type);
    int ends[3] = {node, node, -1}; /* a corner is the middle of itself and itself */
    if (node < 0 || node >= sb_element_node_count(type))
        return 0;
    if (node >= corners)
        sb_element_edge(type, node - corners, ends);
    for (int k = 0; k < 3; k++) {
        if (type == SB_HEX8 || type == SB_QUAD4)
            xi[k] = k < dimension ? (sb_real)sbi_element_hex_corners[node][k] : (sb_real)0;
        else
            xi[k] = (sb_real)0.5 * (sb_real)((ends[0] == k + 1) + (ends[1] == k + 1));
    }
    return 1;
}

/* Simplex of `dimension` in barycentric coordinates L: N_a = L_a, or with mid-edge nodes N_a = L_a (2 L_a -
 * 1) and N_pq = 4 L_p L_q. dL_0 = (-1, -1, -1), dL_k = unit vector k - 1. */
static void sbi_element_shape_simplex(sb_element_type type, const sb_real xi[3], sb_real *shape,
                                      sb_real (*gradient)[3])
{
    int corners = sb_element_corner_count(type), nodes = sb_element_node_count(type);
    sb_real bary[4] = {1, 0, 0, 0}, slope[4][3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
    for (int k = 1; k < corners; k++) {
        bary[0] -= xi[k - 1];
        bary[k] = xi[k - 1];
        slope[0][k - 1] = -1;
        slope[k][k - 1] = 1;
    }
    for (int a = 0; a < corners; a++) {
        sb_real value = nodes > corners ? bary[a] * (2 * bary[a] - 1) : bary[a];
        sb_real factor = nodes > corners ? 4 * bary[a] - 1 : (sb_real)1;
        if (shape)
            shape[a] = value;
        for (int k = 0; gradient && k < 3; k++)
            gradient[a][k] = factor * slope[a][k];
    }
    for (int a = corners; a < nodes; a++) {
        int p = sbi_element_edges(type)[a - corners][0], q = sbi_element_edges(type)[a - corners][1];
        if (shape)
            shape[a] = 4 * bary[p] * bary[q];
        for (int k = 0; gradient && k < 3; k++)
            gradient[a][k] = 4 * (bary[p] * slope[q][k] + bary[q] * slope[p][k]);
    }
}

/* quad4 and hex8: N_c = prod_k (1 + c_k xi_k) / 2 with corners c. */
static void sbi_element_shape_box(int dimension, const sb_real xi[3], sb_real *shape, sb_real (*gradient)[3])
{
    const sb_real half = (sb_real)0.5;
    for (int a = 0; a < (1 << dimension); a++) {
        sb_real factor[3] = {1, 1, 1}, slope[3] = {0, 0, 0};
        for (int k = 0; k < dimension; k++) {
            slope[k] = half * (sb_real)sbi_element_hex_corners[a][k];
            factor[k] = half + slope[k] * xi[k];
        }
        if (shape)
            shape[a] = factor[0] * factor[1] * factor[2];
        if (gradient) {
            gradient[a][0] = slope[0] * factor[1] * factor[2];
            gradient[a][1] = factor[0] * slope[1] * factor[2];
            gradient[a][2] = factor[0] * factor[1] * slope[2];
        }
    }
}

SB_API void sb_element_shape(sb_element_type type, const sb_real xi[3], sb_real *shape,
                             sb_real (*gradient)[3])
{
    if (type == SB_HEX8 || type == SB_QUAD4)
        sbi_element_shape_box(sb_element_dimension(type), xi, shape, gradient);
    else
        sbi_element_shape_simplex(type, xi, shape, gradient);
}

/* ---- quadrature ---- */

/* A rule being collected point by point. */
typedef struct sbi_element_rule {
    sb_real (*points)[3];
    sb_real *weights;
    int count;
} sbi_element_rule;

static void sbi_element_rule_add(sbi_element_rule *rule, sb_real r, sb_real s, sb_real t, sb_real weight)
{
    rule->points[rule->count][0] = r;
    rule->points[rule->count][1] = s;
    rule->points[rule->count][2] = t;
    rule->weights[rule->count] = weight;
    rule->count++;
}

/* The four points with three barycentric coordinates a, nearest to (a < 1/4) or farthest from corner 0, 1, 2,
 * 3. */
static void sbi_element_rule_tet_corners(sbi_element_rule *rule, double a, double weight)
{
    for (int corner = 0; corner < 4; corner++) {
        sb_real bary[4];
        for (int k = 0; k < 4; k++)
            bary[k] = (sb_real)(k == corner ? 1 - 3 * a : a);
        sbi_element_rule_add(rule, bary[1], bary[2], bary[3], (sb_real)(weight / 6));
    }
}

/* The six points with two barycentric coordinates c and two 1/2 - c, by the edges they are nearest to. */
static void sbi_element_rule_tet_edges(sbi_element_rule *rule, double c, double weight)
{
    for (int edge = 0; edge < 6; edge++) {
        sb_real bary[4] = {(sb_real)c, (sb_real)c, (sb_real)c, (sb_real)c};
        bary[sbi_element_tet_edges[edge][0]] = bary[sbi_element_tet_edges[edge][1]] = (sb_real)(0.5 - c);
        sbi_element_rule_add(rule, bary[1], bary[2], bary[3], (sb_real)(weight / 6));
    }
}

/* The three points of a triangle with two barycentric coordinates a. */
static void sbi_element_rule_triangle(sbi_element_rule *rule, double a, double weight)
{
    for (int corner = 0; corner < 3; corner++)
        sbi_element_rule_add(rule, (sb_real)(corner == 1 ? 1 - 2 * a : a),
                             (sb_real)(corner == 2 ? 1 - 2 * a : a), 0, (sb_real)(weight / 2));
}

/* Tet rules of degree 1, 2, 3 and 5 with 1, 4, 8 and 14 points (the last is Walkington's). */
static void sbi_element_rule_tet(sbi_element_rule *rule, int count)
{
    switch (count) {
    case 1:
        sbi_element_rule_add(rule, (sb_real)0.25, (sb_real)0.25, (sb_real)0.25, (sb_real)(1.0 / 6));
        break;
    case 4: /* a = (5 - sqrt(5)) / 20 */
        sbi_element_rule_tet_corners(rule, 0.13819660112501051518, 0.25);
        break;
    case 8: /* corners and face centroids: all weights positive */
        sbi_element_rule_tet_corners(rule, 0, 1.0 / 40);
        sbi_element_rule_tet_corners(rule, 1.0 / 3, 9.0 / 40);
        break;
    default:
        sbi_element_rule_tet_corners(rule, 0.3108859192633005, 0.1126879257180162);
        sbi_element_rule_tet_corners(rule, 0.0927352503108912, 0.0734930431163619);
        sbi_element_rule_tet_edges(rule, 0.0455037041256497, 0.0425460207770812);
        break;
    }
}

/* Gauss points +-1/sqrt(3) per direction, xi fastest. */
static void sbi_element_rule_box(sbi_element_rule *rule, int dimension)
{
    const sb_real g = (sb_real)0.57735026918962576451;
    for (int i = 0; i < (1 << dimension); i++)
        sbi_element_rule_add(rule, i & 1 ? g : -g, i & 2 ? g : -g,
                             dimension == 2 ? (sb_real)0 : (i & 4 ? g : -g), 1);
}

/* Surfaces: tri3 degree 2, tri6 degree 4 (a follower pressure needs it), quad4 degree 3. */
static void sbi_element_rule_surface(sbi_element_rule *rule, sb_element_type type)
{
    if (type == SB_TRI3) {
        sbi_element_rule_triangle(rule, 1.0 / 6, 1.0 / 3);
    } else if (type == SB_TRI6) {
        sbi_element_rule_triangle(rule, 0.445948490915965, 0.223381589678011);
        sbi_element_rule_triangle(rule, 0.091576213509771, 0.109951743655322);
    } else {
        sbi_element_rule_box(rule, 2);
    }
}

/* Points of a tet rule for a purpose; 0: there is none. */
static int sbi_element_tet_points(sb_element_type type, sb_quadrature_kind kind)
{
    switch (kind) {
    case SB_QUADRATURE_STIFFNESS: return type == SB_TET4 ? 1 : 4;
    case SB_QUADRATURE_STIFFNESS_CURVED: return type == SB_TET4 ? 1 : 8;
    case SB_QUADRATURE_MASS: return type == SB_TET4 ? 4 : 14;
    case SB_QUADRATURE_FACE: break;
    }
    return 0;
}

SB_API int sb_element_quadrature(sb_element_type type, sb_quadrature_kind kind,
                                 sb_real points[SB_MAX_QUADRATURE_POINTS][3],
                                 sb_real weights[SB_MAX_QUADRATURE_POINTS])
{
    int dimension = sb_element_dimension(type), tet_points = sbi_element_tet_points(type, kind);
    sbi_element_rule rule;
    rule.points = points;
    rule.weights = weights;
    rule.count = 0;
    if (kind < SB_QUADRATURE_STIFFNESS || kind > SB_QUADRATURE_FACE)
        return 0;
    if (dimension == 2)
        sbi_element_rule_surface(&rule, type);
    else if (dimension == 3 && tet_points > 0 && type == SB_HEX8)
        sbi_element_rule_box(&rule, 3);
    else if (dimension == 3 && tet_points > 0)
        sbi_element_rule_tet(&rule, tet_points);
    return rule.count;
}

/* ==== src/softbody/mesh.c ==== */
/* mesh: checks, geometry, repairs, topology, reordering.
 *
 * Faces, edges and whole elements are compared through their corner nodes sorted ascending ("keys"). Sorting
 * the keys column by column with counting sort takes linear time whatever the numbering, needs no hashing,
 * and leaves equal keys side by side in the order of the elements, so every result is unique. */

#include <limits.h>
#include <stdio.h>
#include <string.h>

#define SBI_MESH_LISTED 8 /* elements that an error message names */

static sb_result sbi_mesh_no_memory(sb_error *error)
{
    return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the tables of a mesh");
}

static const int *sbi_mesh_element(const sb_mesh *mesh, int element)
{
    return mesh->elements + (size_t)element * (size_t)sb_element_node_count(mesh->element_type);
}

/* ---- life ---- */

SB_API void sb_mesh_free(sb_mesh *mesh)
{
    if (!mesh)
        return;
    sbi_free(&mesh->allocator, mesh->nodes);
    sbi_free(&mesh->allocator, mesh->elements);
    sbi_free(&mesh->allocator, mesh->regions);
    memset(mesh, 0, sizeof *mesh);
}

static void sbi_mesh_set_allocator(sb_allocator *target, const sb_allocator *allocator)
{
    memset(target, 0, sizeof *target);
    if (allocator)
        *target = *allocator;
}

SBI_API int sbi_mesh_allocate(sb_mesh *mesh, sb_element_type type, int node_count, int element_count,
                              int with_regions, const sb_allocator *allocator)
{
    size_t per_element = sizeof(int) * (size_t)sb_element_node_count(type);
    memset(mesh, 0, sizeof *mesh);
    sbi_mesh_set_allocator(&mesh->allocator, allocator);
    mesh->nodes = (sb_vec3 *)sbi_alloc(allocator, (size_t)node_count, sizeof(sb_vec3));
    mesh->elements = (int *)sbi_alloc(allocator, (size_t)element_count, per_element);
    if (with_regions)
        mesh->regions = (int *)sbi_alloc(allocator, (size_t)element_count, sizeof(int));
    mesh->element_type = type;
    mesh->node_count = node_count;
    mesh->element_count = element_count;
    if (mesh->nodes && mesh->elements && (mesh->regions || !with_regions))
        return 1;
    sb_mesh_free(mesh);
    return 0;
}

/* Counts, type and pointers; what the arrays hold is not looked at. */
static sb_result sbi_mesh_check_shape(const sb_mesh *mesh, sb_error *error)
{
    if (!mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "mesh is NULL");
    if (sb_element_node_count(mesh->element_type) == 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "mesh has unknown element type %d",
                        (int)mesh->element_type);
    if (mesh->node_count < 0 || mesh->element_count < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "mesh has %d nodes and %d elements", mesh->node_count,
                        mesh->element_count);
    if (mesh->node_count == 0 || mesh->element_count == 0)
        return sbi_fail(error, SB_ERROR_MESH, "mesh is empty: %d nodes, %d elements", mesh->node_count,
                        mesh->element_count);
    if (!mesh->nodes || !mesh->elements)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "mesh has no array of %s",
                        mesh->nodes ? "elements" : "nodes");
    return SB_OK;
}

static sb_result sbi_mesh_check_nodes(const sb_mesh *mesh, sb_error *error)
{
    for (int i = 0; i < mesh->node_count; i++)
        if (!sb_v3_is_finite(mesh->nodes[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "node %d has a coordinate that is not finite",
                                 i);
    return SB_OK;
}

/* An index of the element that names no node, through *index; 0 when there is none. */
static int sbi_mesh_index_out_of_range(const sb_mesh *mesh, int element, int *index)
{
    const int *nodes = sbi_mesh_element(mesh, element);
    int n = sb_element_node_count(mesh->element_type);
    for (int a = 0; a < n; a++) {
        if (nodes[a] < 0 || nodes[a] >= mesh->node_count) {
            *index = nodes[a];
            return 1;
        }
    }
    return 0;
}

SBI_API sb_result sbi_mesh_check_arrays(const sb_mesh *mesh, sb_error *error)
{
    int index = 0;
    sb_result result = sbi_mesh_check_shape(mesh, error);
    if (result == SB_OK)
        result = sbi_mesh_check_nodes(mesh, error);
    for (int e = 0; result == SB_OK && e < mesh->element_count; e++)
        if (sbi_mesh_index_out_of_range(mesh, e, &index))
            result = sbi_fail_element(error, SB_ERROR_INDEX, e, "element %d refers to node %d of %d", e,
                                      index, mesh->node_count);
    return result;
}

SB_API sb_result sb_mesh_copy(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *copy,
                              sb_error *error)
{
    sb_mesh made;
    size_t nodes_per_element;
    sb_result result = sbi_mesh_check_shape(mesh, error);
    if (result != SB_OK)
        return result;
    if (!copy)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "copy is NULL");
    if (!sbi_mesh_allocate(&made, mesh->element_type, mesh->node_count, mesh->element_count,
                           mesh->regions != NULL, allocator))
        return sbi_mesh_no_memory(error);
    nodes_per_element = (size_t)sb_element_node_count(mesh->element_type);
    memcpy(made.nodes, mesh->nodes, sizeof(sb_vec3) * (size_t)mesh->node_count);
    memcpy(made.elements, mesh->elements, sizeof(int) * nodes_per_element * (size_t)mesh->element_count);
    if (mesh->regions)
        memcpy(made.regions, mesh->regions, sizeof(int) * (size_t)mesh->element_count);
    *copy = made;
    return SB_OK;
}

/* ---- Jacobians ---- */

enum { SBI_MESH_SAMPLES = 28, SBI_MESH_NODES = 10 };

/* Shape functions at a set of points, made once for all elements. */
typedef struct sbi_mesh_table {
    int count;
    sb_real weight[SBI_MESH_SAMPLES];
    sb_real shape[SBI_MESH_SAMPLES][SBI_MESH_NODES];
    sb_real gradient[SBI_MESH_SAMPLES][SBI_MESH_NODES][3];
} sbi_mesh_table;

static void sbi_mesh_table_add(sbi_mesh_table *table, sb_element_type type, const sb_real xi[3],
                               sb_real weight)
{
    sb_element_shape(type, xi, table->shape[table->count], table->gradient[table->count]);
    table->weight[table->count++] = weight;
}

static void sbi_mesh_table_add_rule(sbi_mesh_table *table, sb_element_type type, sb_quadrature_kind kind)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    int count = sb_element_quadrature(type, kind, points, weights);
    for (int i = 0; i < count; i++)
        sbi_mesh_table_add(table, type, points[i], weights[i]);
}

/* The points to integrate volumes and areas with: exact for all volumes (tet10: degree 3). */
static void sbi_mesh_table_for_volume(sbi_mesh_table *table, sb_element_type type)
{
    table->count = 0;
    sbi_mesh_table_add_rule(table, type, SB_QUADRATURE_STIFFNESS_CURVED);
}

/* The points where a Jacobian must be positive: all nodes first; tet10: also the face centroids (the last
 * four of its 8-point rule) and the 14 points of its mass rule; hex8: also Gauss points. */
static void sbi_mesh_table_for_checks(sbi_mesh_table *table, sb_element_type type)
{
    sb_real xi[3] = {0, 0, 0}, points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    table->count = 0;
    for (int a = 0; sb_element_node_point(type, a, xi); a++)
        sbi_mesh_table_add(table, type, xi, 0);
    if (type == SB_TET10) {
        sb_element_quadrature(type, SB_QUADRATURE_STIFFNESS_CURVED, points, weights);
        for (int i = 4; i < 8; i++)
            sbi_mesh_table_add(table, type, points[i], 0);
    }
    if (type == SB_TET10 || type == SB_HEX8)
        sbi_mesh_table_add_rule(table, type, SB_QUADRATURE_MASS);
}

/* An element's nodes relative to its first and divided by its largest extent `size` (m), so that no product
 * over- or underflows at any scale of the mesh; `rounding`: bound of the relative error of a Jacobian made
 * from them. */
typedef struct sbi_mesh_local {
    sb_vec3 x[SBI_MESH_NODES];
    sb_real size, rounding;
} sbi_mesh_local;

static sb_real sbi_mesh_max_abs(sb_vec3 v) { return sb_max(sb_abs(v.x), sb_max(sb_abs(v.y), sb_abs(v.z))); }

static void sbi_mesh_local_make(const sb_mesh *mesh, int element, sbi_mesh_local *local)
{
    const int *nodes = sbi_mesh_element(mesh, element);
    int n = sb_element_node_count(mesh->element_type);
    sb_vec3 origin = mesh->nodes[nodes[0]];
    sb_real magnitude = 0;
    local->size = 0;
    for (int a = 0; a < n; a++) {
        local->x[a] = sb_v3_sub(mesh->nodes[nodes[a]], origin);
        local->size = sb_max(local->size, sbi_mesh_max_abs(local->x[a]));
        magnitude = sb_max(magnitude, sbi_mesh_max_abs(mesh->nodes[nodes[a]]));
    }
    local->rounding = 8 * SB_EPSILON; /* coordinates carry an absolute error of eps * magnitude */
    if (local->size > 0) {
        local->rounding *= 1 + magnitude / local->size;
        for (int a = 0; a < n; a++)
            local->x[a] =
                sb_v3(local->x[a].x / local->size, local->x[a].y / local->size, local->x[a].z / local->size);
    }
}

/* Columns dx/dxi at sample `point` of the table. */
static sb_mat3 sbi_mesh_jacobian(const sbi_mesh_table *table, int point, int node_count, const sb_vec3 *x)
{
    sb_vec3 column[3];
    for (int k = 0; k < 3; k++) {
        column[k] = sb_v3(0, 0, 0);
        for (int a = 0; a < node_count; a++)
            column[k] = sb_v3_madd(column[k], table->gradient[point][a][k], x[a]);
    }
    return sb_m3_columns(column[0], column[1], column[2]);
}

static sb_real sbi_mesh_corner_det(const sb_vec3 *x)
{
    return sb_m3_det(sb_m3_columns(sb_v3_sub(x[1], x[0]), sb_v3_sub(x[2], x[0]), sb_v3_sub(x[3], x[0])));
}

/* ---- defects of one element ---- */

static sb_mesh_defect sbi_mesh_defect_of_sign(sb_real det, sb_real rounding)
{
    if (det > rounding)
        return SB_MESH_SOUND;
    return det < -rounding ? SB_MESH_INVERTED
                           : SB_MESH_FLAT; /* flat: also NaN from coordinates near the largest */
}

/* Worst sign of the Jacobian over the table's points, inverted before flat. */
static sb_mesh_defect sbi_mesh_sampled_defect(const sbi_mesh_table *table, int node_count,
                                              const sbi_mesh_local *local)
{
    sb_mesh_defect worst = SB_MESH_SOUND;
    for (int i = 0; i < table->count; i++) {
        sb_real det = sb_m3_det(sbi_mesh_jacobian(table, i, node_count, local->x));
        sb_mesh_defect defect = sbi_mesh_defect_of_sign(det, local->rounding);
        if (defect == SB_MESH_INVERTED)
            return defect;
        if (defect != SB_MESH_SOUND)
            worst = defect;
    }
    return worst;
}

static sb_mesh_defect sbi_mesh_shape_defect(const sb_mesh *mesh, const sbi_mesh_table *table, int element)
{
    sb_mesh_defect defect;
    sbi_mesh_local local;
    sbi_mesh_local_make(mesh, element, &local);
    if (sb_element_dimension(mesh->element_type) == 2) {
        sb_vec3 across = mesh->element_type == SB_QUAD4 ? sb_v3_sub(local.x[3], local.x[1]) : local.x[1];
        return sb_v3_norm(sb_v3_cross(local.x[2], across)) > local.rounding ? SB_MESH_SOUND : SB_MESH_FLAT;
    }
    if (mesh->element_type == SB_HEX8)
        return sbi_mesh_sampled_defect(table, 8, &local);
    defect = sbi_mesh_defect_of_sign(sbi_mesh_corner_det(local.x), local.rounding);
    if (defect != SB_MESH_SOUND || mesh->element_type == SB_TET4)
        return defect;
    return sbi_mesh_sampled_defect(table, 10, &local) == SB_MESH_SOUND ? SB_MESH_SOUND : SB_MESH_BAD_MIDSIDE;
}

static int sbi_mesh_has_repeated_node(const int *nodes, int count)
{
    for (int a = 1; a < count; a++)
        for (int b = 0; b < a; b++)
            if (nodes[a] == nodes[b])
                return 1;
    return 0;
}

/* First defect that an element has by itself (so not SB_MESH_DUPLICATE). */
static sb_mesh_defect sbi_mesh_element_defect(const sb_mesh *mesh, const sbi_mesh_table *table, int element)
{
    const int *nodes = sbi_mesh_element(mesh, element);
    int n = sb_element_node_count(mesh->element_type), index;
    if (sbi_mesh_index_out_of_range(mesh, element, &index))
        return SB_MESH_INDEX_RANGE;
    for (int a = 0; a < n; a++)
        if (!sb_v3_is_finite(mesh->nodes[nodes[a]]))
            return SB_MESH_NODE_NOT_FINITE;
    if (sbi_mesh_has_repeated_node(nodes, n))
        return SB_MESH_REPEATED_NODE;
    return sbi_mesh_shape_defect(mesh, table, element);
}

/* ---- validation ---- */

/* The elements with one kind of defect: how many, and the first few. */
typedef struct sbi_mesh_offenders {
    int count;
    int first[SBI_MESH_LISTED];
} sbi_mesh_offenders;

static const char *sbi_mesh_defect_text(sb_mesh_defect defect)
{
    switch (defect) {
    case SB_MESH_INDEX_RANGE: return "with a node index out of range";
    case SB_MESH_NODE_NOT_FINITE: return "with a node that is not finite";
    case SB_MESH_REPEATED_NODE: return "with a node used twice";
    case SB_MESH_INVERTED: return "inverted (negative volume)";
    case SB_MESH_FLAT: return "flat (zero volume)";
    case SB_MESH_BAD_MIDSIDE: return "folded by a misplaced mid-edge node";
    case SB_MESH_DUPLICATE: return "with the corners of an element before it";
    case SB_MESH_SOUND:
    case SB_MESH_DEFECT_COUNT: break;
    }
    return "sound";
}

/* "3 elements inverted (negative volume): 3, 17, 40" */
static sb_result sbi_mesh_fail_elements(const sb_mesh *mesh, const sbi_mesh_offenders *offenders,
                                        sb_mesh_defect defect, sb_error *error)
{
    char list[16 * SBI_MESH_LISTED], index_text[64];
    size_t used = 0;
    int listed = offenders->count < SBI_MESH_LISTED ? offenders->count : SBI_MESH_LISTED, index = 0;
    list[0] = index_text[0] = 0;
    for (int i = 0; i < listed; i++)
        used += (size_t)snprintf(list + used, sizeof list - used, "%s%d", i ? ", " : "", offenders->first[i]);
    if (defect == SB_MESH_INDEX_RANGE && sbi_mesh_index_out_of_range(mesh, offenders->first[0], &index))
        snprintf(index_text, sizeof index_text, " (the first: %d of %d nodes)", index, mesh->node_count);
    return sbi_fail_element(error, defect == SB_MESH_INDEX_RANGE ? SB_ERROR_INDEX : SB_ERROR_MESH,
                            offenders->first[0], "%d element%s %s%s: %s%s", offenders->count,
                            offenders->count == 1 ? "" : "s", sbi_mesh_defect_text(defect), index_text, list,
                            offenders->count > listed ? ", ..." : "");
}

SB_API sb_result sb_mesh_validate(const sb_mesh *mesh, sb_error *error)
{
    static const sb_mesh_defect order[] = {SB_MESH_INDEX_RANGE, SB_MESH_REPEATED_NODE, SB_MESH_INVERTED,
                                           SB_MESH_FLAT, SB_MESH_BAD_MIDSIDE};
    sbi_mesh_offenders found[SB_MESH_DEFECT_COUNT];
    sbi_mesh_table table;
    sb_result result = sbi_mesh_check_shape(mesh, error);
    if (result == SB_OK)
        result = sbi_mesh_check_nodes(mesh, error);
    if (result != SB_OK)
        return result;
    memset(found, 0, sizeof found);
    sbi_mesh_table_for_checks(&table, mesh->element_type);
    for (int e = 0; e < mesh->element_count; e++) {
        sb_mesh_defect defect = sbi_mesh_element_defect(mesh, &table, e);
        if (found[defect].count < SBI_MESH_LISTED)
            found[defect].first[found[defect].count] = e;
        found[defect].count++;
    }
    if (sb_element_dimension(mesh->element_type) == 2)
        found[SB_MESH_FLAT].count = 0; /* a sliver triangle harms no target or visual surface */
    for (size_t i = 0; i < sizeof order / sizeof order[0]; i++)
        if (found[order[i]].count)
            return sbi_mesh_fail_elements(mesh, &found[order[i]], order[i], error);
    return SB_OK;
}

/* ---- keys: faces, edges and elements by their sorted corners ---- */

typedef enum sbi_mesh_part {
    SBI_MESH_SIDES, /* faces of volumes, edges of surfaces */
    SBI_MESH_EDGES,
    SBI_MESH_WHOLE
} sbi_mesh_part;

/* Parts of all elements; part p belongs to element p / per_element. */
typedef struct sbi_mesh_keys {
    int count; /* parts */
    int per_element;
    int width;  /* corners per part */
    int sorted; /* parts in `order`: those of elements that were not skipped */
    int *keys;  /* [count][width] corner nodes, ascending */
    int *order; /* [sorted] parts sorted by key, equal keys by part */
} sbi_mesh_keys;

static void sbi_mesh_keys_free(const sb_allocator *allocator, sbi_mesh_keys *keys)
{
    sbi_free(allocator, keys->keys);
    sbi_free(allocator, keys->order);
    memset(keys, 0, sizeof *keys);
}

/* Local corner numbers of a part of an element; returns how many. */
static int sbi_mesh_part_corners(sb_element_type type, sbi_mesh_part part, int index,
                                 int corners[SB_MAX_ELEMENT_NODES])
{
    sb_element_type face_type = SB_NO_ELEMENT;
    if (part == SBI_MESH_WHOLE) {
        int count = sb_element_corner_count(type);
        for (int a = 0; a < count; a++)
            corners[a] = a;
        return count;
    }
    if (part == SBI_MESH_EDGES || sb_element_dimension(type) == 2) {
        sb_element_edge(type, index, corners);
        return 2;
    }
    sb_element_face(type, index, corners, &face_type);
    return sb_element_corner_count(face_type);
}

static int sbi_mesh_parts_per_element(sb_element_type type, sbi_mesh_part part)
{
    if (part == SBI_MESH_WHOLE)
        return 1;
    return part == SBI_MESH_EDGES || sb_element_dimension(type) == 2 ? sb_element_edge_count(type)
                                                                     : sb_element_face_count(type);
}

static void sbi_mesh_insertion_sort(int *values, int count)
{
    for (int i = 1; i < count; i++) {
        int value = values[i], j = i;
        for (; j > 0 && values[j - 1] > value; j--)
            values[j] = values[j - 1];
        values[j] = value;
    }
}

static void sbi_mesh_keys_fill(const sb_mesh *mesh, sbi_mesh_part part, const unsigned char *skip,
                               sbi_mesh_keys *keys)
{
    int corners[12][SB_MAX_ELEMENT_NODES];
    for (int i = 0; i < keys->per_element; i++)
        sbi_mesh_part_corners(mesh->element_type, part, i, corners[i]);
    keys->sorted = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = sbi_mesh_element(mesh, e);
        for (int i = 0; i < keys->per_element && !(skip && skip[e]); i++) {
            int p = e * keys->per_element + i;
            int *key = keys->keys + (size_t)p * (size_t)keys->width;
            for (int k = 0; k < keys->width; k++)
                key[k] = nodes[corners[i][k]];
            sbi_mesh_insertion_sort(key, keys->width);
            keys->order[keys->sorted++] = p;
        }
    }
}

/* One stable counting sort of the order by a column of the keys; start has node_count + 1 entries. */
static void sbi_mesh_sort_column(const sbi_mesh_keys *keys, int column, int node_count, const int *from,
                                 int *to, int *start)
{
    const int *value = keys->keys + column;
    memset(start, 0, sizeof(int) * ((size_t)node_count + 1));
    for (int i = 0; i < keys->sorted; i++)
        start[value[(size_t)from[i] * (size_t)keys->width] + 1]++;
    for (int v = 0; v < node_count; v++)
        start[v + 1] += start[v];
    for (int i = 0; i < keys->sorted; i++)
        to[start[value[(size_t)from[i] * (size_t)keys->width]]++] = from[i];
}

static int sbi_mesh_keys_sort(const sb_allocator *allocator, sbi_mesh_keys *keys, int node_count)
{
    int *other = (int *)sbi_alloc(allocator, (size_t)keys->sorted, sizeof(int));
    int *start = (int *)sbi_alloc(allocator, (size_t)node_count + 1, sizeof(int));
    int ok = other && start;
    for (int column = keys->width - 1; ok && column >= 0; column--) {
        int *swap = keys->order;
        sbi_mesh_sort_column(keys, column, node_count, keys->order, other, start);
        keys->order = other;
        other = swap;
    }
    sbi_free(allocator, other);
    sbi_free(allocator, start);
    return ok;
}

/* Sorted keys of all parts of the elements that `skip` (may be NULL) does not mark; their indices are in
 * range. 0 when memory is short or the parts do not fit an int. */
static int sbi_mesh_keys_make(const sb_mesh *mesh, sbi_mesh_part part, const unsigned char *skip,
                              const sb_allocator *allocator, sbi_mesh_keys *keys)
{
    int corners[SB_MAX_ELEMENT_NODES];
    memset(keys, 0, sizeof *keys);
    keys->per_element = sbi_mesh_parts_per_element(mesh->element_type, part);
    keys->width = sbi_mesh_part_corners(mesh->element_type, part, 0, corners);
    if (mesh->element_count > INT_MAX / keys->per_element)
        return 0;
    keys->count = mesh->element_count * keys->per_element;
    keys->keys = (int *)sbi_alloc(allocator, (size_t)keys->count, sizeof(int) * (size_t)keys->width);
    keys->order = (int *)sbi_alloc(allocator, (size_t)keys->count, sizeof(int));
    if (keys->keys && keys->order) {
        sbi_mesh_keys_fill(mesh, part, skip, keys);
        if (sbi_mesh_keys_sort(allocator, keys, mesh->node_count))
            return 1;
    }
    sbi_mesh_keys_free(allocator, keys);
    return 0;
}

/* End of the run of equal keys that begins at position `begin` of the order. */
static int sbi_mesh_run_end(const sbi_mesh_keys *keys, int begin)
{
    size_t width = (size_t)keys->width;
    const int *key = keys->keys + (size_t)keys->order[begin] * width;
    int end = begin + 1;
    while (end < keys->sorted &&
           memcmp(key, keys->keys + (size_t)keys->order[end] * width, sizeof(int) * width) == 0)
        end++;
    return end;
}

enum { SBI_MESH_ALONE = -1, SBI_MESH_CROWDED = -2 };

/* mate[part]: the one other part with the same key, or ALONE, or CROWDED (two others or more, or skipped). */
static int *sbi_mesh_mates(const sbi_mesh_keys *keys, const sb_allocator *allocator)
{
    int *mate = (int *)sbi_alloc(allocator, (size_t)keys->count, sizeof(int));
    for (int p = 0; mate && p < keys->count; p++)
        mate[p] = SBI_MESH_CROWDED;
    for (int begin = 0, end; mate && begin < keys->sorted; begin = end) {
        end = sbi_mesh_run_end(keys, begin);
        if (end == begin + 1)
            mate[keys->order[begin]] = SBI_MESH_ALONE;
        if (end == begin + 2) {
            mate[keys->order[begin]] = keys->order[begin + 1];
            mate[keys->order[begin + 1]] = keys->order[begin];
        }
    }
    return mate;
}

/* ---- disjoint sets ---- */

static int sbi_mesh_find(int *parent, int i)
{
    while (parent[i] != i) {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    return i;
}

/* The smaller root becomes the root of both, so roots come first in every numbering. */
static void sbi_mesh_unite(int *parent, int a, int b)
{
    int root_a = sbi_mesh_find(parent, a), root_b = sbi_mesh_find(parent, b);
    if (root_a < root_b)
        parent[root_b] = root_a;
    else
        parent[root_a] = root_b;
}

/* Labels of the parts that share nodes, in the order of their first elements; skipped elements get -1.
 * scratch: [node_count]. Returns the number of parts. */
static int sbi_mesh_label_components(const sb_mesh *mesh, const unsigned char *skip, int *label, int *scratch)
{
    int n = sb_element_node_count(mesh->element_type), count = 0;
    for (int v = 0; v < mesh->node_count; v++)
        scratch[v] = -1;
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = sbi_mesh_element(mesh, e);
        label[e] = e;
        for (int a = 0; a < n && !(skip && skip[e]); a++) {
            if (scratch[nodes[a]] < 0)
                scratch[nodes[a]] = e;
            else
                sbi_mesh_unite(label, e, scratch[nodes[a]]);
        }
    }
    /* Roots precede their members: flatten in order, numbering roots as -2 - number until all are reached. */
    for (int e = 0; e < mesh->element_count; e++)
        label[e] = sbi_mesh_find(label, e);
    for (int e = 0; e < mesh->element_count; e++) {
        if (skip && skip[e])
            label[e] = -1;
        else
            label[e] = label[e] == e ? -2 - count++ : label[label[e]];
    }
    for (int e = 0; e < mesh->element_count; e++)
        label[e] = label[e] == -1 ? -1 : -2 - label[e];
    return count;
}

/* ---- nodes that coincide ---- */

typedef struct sbi_mesh_grid {
    sb_vec3 low;
    sb_real cell, tolerance; /* m */
    uint64_t mask;           /* buckets - 1 */
    int *head;               /* [buckets] last node of each bucket, or -1 */
    int *next;               /* [nodes] */
} sbi_mesh_grid;

static int64_t sbi_mesh_grid_cell(sb_real position)
{
    int64_t cell = (int64_t)position;
    return (sb_real)cell > position ? cell - 1 : cell;
}

static size_t sbi_mesh_grid_bucket(const sbi_mesh_grid *grid, int64_t i, int64_t j, int64_t k)
{
    uint64_t hash = (uint64_t)i * 0x9E3779B97F4A7C15u;
    hash = (hash ^ (hash >> 29) ^ (uint64_t)j) * 0xBF58476D1CE4E5B9u;
    hash = (hash ^ (hash >> 32) ^ (uint64_t)k) * 0x94D049BB133111EBu;
    return (size_t)((hash ^ (hash >> 31)) & grid->mask);
}

static int sbi_mesh_is_near(sb_vec3 a, sb_vec3 b, sb_real tolerance)
{
    sb_vec3 d = sb_v3_sub(a, b);
    if (tolerance <= 0)
        return d.x == 0 && d.y == 0 && d.z == 0;
    d = sb_v3(d.x / tolerance, d.y / tolerance, d.z / tolerance);
    return sb_v3_dot(d, d) <= 1;
}

/* Smallest node of the grid within tolerance of node `node`, or -1. */
static int sbi_mesh_grid_find(const sbi_mesh_grid *grid, const sb_vec3 *nodes, int node)
{
    const sb_real reach = grid->tolerance;
    sb_vec3 d = sb_v3_sub(nodes[node], grid->low);
    int64_t i1 = sbi_mesh_grid_cell((d.x + reach) / grid->cell),
            j1 = sbi_mesh_grid_cell((d.y + reach) / grid->cell),
            k1 = sbi_mesh_grid_cell((d.z + reach) / grid->cell);
    int best = -1;
    for (int64_t i = sbi_mesh_grid_cell((d.x - reach) / grid->cell); i <= i1; i++)
        for (int64_t j = sbi_mesh_grid_cell((d.y - reach) / grid->cell); j <= j1; j++)
            for (int64_t k = sbi_mesh_grid_cell((d.z - reach) / grid->cell); k <= k1; k++)
                for (int v = grid->head[sbi_mesh_grid_bucket(grid, i, j, k)]; v >= 0; v = grid->next[v])
                    if ((best < 0 || v < best) && sbi_mesh_is_near(nodes[v], nodes[node], reach))
                        best = v;
    return best;
}

static void sbi_mesh_grid_add(const sbi_mesh_grid *grid, const sb_vec3 *nodes, int node)
{
    sb_vec3 d = sb_v3_sub(nodes[node], grid->low);
    size_t bucket =
        sbi_mesh_grid_bucket(grid, sbi_mesh_grid_cell(d.x / grid->cell), sbi_mesh_grid_cell(d.y / grid->cell),
                             sbi_mesh_grid_cell(d.z / grid->cell));
    grid->next[node] = grid->head[bucket];
    grid->head[bucket] = node;
}

/* Box around the finite nodes; 0 when there are none. */
static int sbi_mesh_finite_bounds(const sb_mesh *mesh, sb_vec3 *low, sb_vec3 *high)
{
    int found = 0;
    for (int v = 0; v < mesh->node_count; v++) {
        sb_vec3 x = mesh->nodes[v];
        if (!sb_v3_is_finite(x))
            continue;
        *low = found ? sb_v3(sb_min(low->x, x.x), sb_min(low->y, x.y), sb_min(low->z, x.z)) : x;
        *high = found ? sb_v3(sb_max(high->x, x.x), sb_max(high->y, x.y), sb_max(high->z, x.z)) : x;
        found = 1;
    }
    return found;
}

/* Cells of four tolerances keep the nodes per cell few and mostly spare a look at the neighbours; never below
 * the spacing of numbers, so that cell indices fit. 0: the box is too large for its size to be a number. */
static int sbi_mesh_grid_setup(const sb_mesh *mesh, sb_real tolerance, sbi_mesh_grid *grid)
{
    sb_vec3 high = sb_v3(0, 0, 0);
    sb_real extent;
    grid->low = high;
    sbi_mesh_finite_bounds(mesh, &grid->low, &high);
    extent = sbi_mesh_max_abs(sb_v3_sub(high, grid->low));
    if (!sb_is_finite(2 * extent))
        return 0;
    grid->tolerance = tolerance < 0 ? (sb_real)1e-6 * extent : sb_min(tolerance, 2 * extent);
    grid->cell = sb_max(4 * (grid->tolerance < extent ? grid->tolerance : extent), 4 * SB_EPSILON * extent);
    if (!(grid->cell > 0))
        grid->cell = 1; /* all nodes in one point */
    return 1;
}

/* representative[v]: the node that node v merges into (the first near it), v itself when it stays. Returns
 * the number of nodes that go, -1 when memory is short. */
static int sbi_mesh_find_duplicates(const sb_mesh *mesh, sb_real tolerance, const sb_allocator *allocator,
                                    int *representative)
{
    sbi_mesh_grid grid;
    size_t buckets = 1;
    int removed = 0;
    for (int v = 0; v < mesh->node_count; v++)
        representative[v] = v;
    if (!sbi_mesh_grid_setup(mesh, tolerance, &grid))
        return 0;
    while (buckets < (size_t)mesh->node_count)
        buckets *= 2;
    grid.mask = buckets - 1;
    grid.head = (int *)sbi_alloc(allocator, buckets, sizeof(int));
    grid.next = (int *)sbi_alloc(allocator, (size_t)mesh->node_count, sizeof(int));
    for (size_t i = 0; grid.head && i < buckets; i++)
        grid.head[i] = -1;
    for (int v = 0; grid.head && grid.next && v < mesh->node_count; v++) {
        int near = sb_v3_is_finite(mesh->nodes[v]) ? sbi_mesh_grid_find(&grid, mesh->nodes, v) : v;
        if (near < 0)
            sbi_mesh_grid_add(&grid, mesh->nodes, v);
        else if (near != v)
            representative[v] = near, removed++;
    }
    if (!grid.head || !grid.next)
        removed = -1;
    sbi_free(allocator, grid.head);
    sbi_free(allocator, grid.next);
    return removed;
}

/* ---- geometry ---- */

static sb_real sbi_mesh_volume_of(const sb_mesh *mesh, const sbi_mesh_table *table, int element)
{
    const int *nodes = sbi_mesh_element(mesh, element);
    int n = sb_element_node_count(mesh->element_type);
    sb_vec3 x[SBI_MESH_NODES];
    sb_real volume = 0;
    for (int a = 0; a < n; a++)
        x[a] = sb_v3_sub(mesh->nodes[nodes[a]], mesh->nodes[nodes[0]]);
    if (mesh->element_type == SB_TET4)
        return sb_v3_dot(x[1], sb_v3_cross(x[2], x[3])) / 6;
    for (int i = 0; i < table->count; i++)
        volume += table->weight[i] * sb_m3_det(sbi_mesh_jacobian(table, i, n, x));
    return volume;
}

/* Area of a surface element and its share of the enclosed volume, the flux of (x - origin) / 3 through it. */
static void sbi_mesh_area_and_flux(const sb_mesh *mesh, const sbi_mesh_table *table, int element,
                                   sb_vec3 origin, double *area, double *flux)
{
    const int *nodes = sbi_mesh_element(mesh, element);
    int n = sb_element_node_count(mesh->element_type);
    sb_vec3 x[SBI_MESH_NODES], offset = sb_v3_sub(mesh->nodes[nodes[0]], origin);
    *area = *flux = 0;
    for (int a = 0; a < n; a++)
        x[a] = sb_v3_sub(mesh->nodes[nodes[a]], mesh->nodes[nodes[0]]);
    for (int i = 0; i < table->count; i++) {
        sb_mat3 jacobian = sbi_mesh_jacobian(table, i, n, x);
        sb_vec3 normal = sb_v3_cross(sb_m3_column(jacobian, 0), sb_m3_column(jacobian, 1)), point = offset;
        for (int a = 0; a < n; a++)
            point = sb_v3_madd(point, table->shape[i][a], x[a]);
        *area += (double)(table->weight[i] * sb_v3_norm(normal));
        *flux += (double)(table->weight[i] * sb_v3_dot(point, normal)) / 3;
    }
}

static int sbi_mesh_has_element(const sb_mesh *mesh, int element)
{
    return mesh && mesh->nodes && mesh->elements && element >= 0 && element < mesh->element_count &&
           sb_element_node_count(mesh->element_type) > 0;
}

SB_API sb_real sb_mesh_element_volume(const sb_mesh *mesh, int element)
{
    sbi_mesh_table table;
    if (!sbi_mesh_has_element(mesh, element) || sb_element_dimension(mesh->element_type) != 3)
        return 0;
    sbi_mesh_table_for_volume(&table, mesh->element_type);
    return sbi_mesh_volume_of(mesh, &table, element);
}

/* Sums in double, so that a float build's total is as good as its elements. bad (or NULL) marks elements to
 * leave out. */
static void sbi_mesh_measure(const sb_mesh *mesh, const unsigned char *bad, double *area, double *volume)
{
    sbi_mesh_table table;
    sb_vec3 origin = sb_v3(0, 0, 0);
    int has_origin = 0;
    *area = *volume = 0;
    sbi_mesh_table_for_volume(&table, mesh->element_type);
    for (int e = 0; e < mesh->element_count; e++) {
        double element_area = 0, element_volume = 0;
        if (bad && bad[e])
            continue;
        if (!has_origin)
            origin = mesh->nodes[sbi_mesh_element(mesh, e)[0]], has_origin = 1;
        if (sb_element_dimension(mesh->element_type) == 3)
            element_volume = (double)sbi_mesh_volume_of(mesh, &table, e);
        else
            sbi_mesh_area_and_flux(mesh, &table, e, origin, &element_area, &element_volume);
        *area += element_area;
        *volume += element_volume;
    }
}

SB_API sb_real sb_mesh_volume(const sb_mesh *mesh)
{
    double area = 0, volume = 0;
    if (sbi_mesh_has_element(mesh, 0))
        sbi_mesh_measure(mesh, NULL, &area, &volume);
    return (sb_real)volume;
}

SB_API sb_real sb_mesh_surface_area(const sb_mesh *mesh)
{
    double area = 0, volume = 0;
    if (sbi_mesh_has_element(mesh, 0) && sb_element_dimension(mesh->element_type) == 2)
        sbi_mesh_measure(mesh, NULL, &area, &volume);
    return (sb_real)area;
}

SB_API void sb_mesh_bounds(const sb_mesh *mesh, sb_vec3 *low, sb_vec3 *high)
{
    *low = *high = sb_v3(0, 0, 0);
    if (mesh && mesh->nodes)
        sbi_mesh_finite_bounds(mesh, low, high);
}

static sb_real sbi_mesh_edge_squares(sb_element_type type, const sb_vec3 *x)
{
    sb_real sum = 0;
    int ends[3];
    for (int i = 0; i < sb_element_edge_count(type); i++) {
        sb_vec3 edge;
        sb_element_edge(type, i, ends);
        edge = sb_v3_sub(x[ends[1]], x[ends[0]]);
        sum += sb_v3_dot(edge, edge);
    }
    return sum;
}

/* 12 (3V)^(2/3) / sum of squared edges, with the sign of V. */
static sb_real sbi_mesh_tet_quality(const sb_vec3 *x)
{
    sb_real det = sbi_mesh_corner_det(x), root;
    if (det == 0)
        return 0;
    root = sb_cbrt(sb_abs(det) / 2); /* 3V = det / 2 */
    return (det < 0 ? -12 : 12) * root * root / sbi_mesh_edge_squares(SB_TET4, x);
}

/* Smallest triple product of the edges at a corner, scaled to length 1; a quad's third edge is its mean
 * normal. */
static sb_real sbi_mesh_box_quality(const sbi_mesh_table *table, int corners, const sb_vec3 *x)
{
    sb_vec3 mean = corners == 4 ? sb_v3_cross(sb_v3_sub(x[2], x[0]), sb_v3_sub(x[3], x[1])) : sb_v3(0, 0, 0);
    sb_real worst = 1;
    for (int i = 0; i < corners; i++) {
        sb_mat3 jacobian = sbi_mesh_jacobian(table, i, corners, x);
        sb_vec3 a = sb_m3_column(jacobian, 0), b = sb_m3_column(jacobian, 1),
                c = corners == 4 ? mean : sb_m3_column(jacobian, 2);
        sb_real lengths = sb_v3_norm(a) * sb_v3_norm(b) * sb_v3_norm(c);
        sb_real quality = lengths > 0 ? sb_v3_dot(c, sb_v3_cross(a, b)) / lengths : (sb_real)0;
        worst = sb_min(worst, quality);
    }
    return worst;
}

static sb_real sbi_mesh_triangle_quality(const sb_vec3 *x)
{
    sb_real doubled = sb_v3_norm(sb_v3_cross(sb_v3_sub(x[1], x[0]), sb_v3_sub(x[2], x[0])));
    return (sb_real)3.46410161513775458705 * doubled / sbi_mesh_edge_squares(SB_TRI3, x);
}

/* Smallest over largest Jacobian: 1 for straight edges. */
static sb_real sbi_mesh_jacobian_ratio(const sbi_mesh_table *table, const sb_vec3 *x)
{
    sb_real low = SB_REAL_MAX, high = 0;
    for (int i = 0; i < table->count; i++) {
        sb_real det = sb_m3_det(sbi_mesh_jacobian(table, i, 10, x));
        low = sb_min(low, det);
        high = sb_max(high, det);
    }
    return high > 0 ? low / high : (sb_real)0;
}

/* table: sbi_mesh_table_for_checks, whose first points are the nodes. */
static sb_real sbi_mesh_quality_of(const sb_mesh *mesh, const sbi_mesh_table *table, int element)
{
    sb_real quality;
    sbi_mesh_local local;
    sbi_mesh_local_make(mesh, element, &local);
    if (!(local.size > 0))
        return 0;
    switch (mesh->element_type) {
    case SB_TET4: return sbi_mesh_tet_quality(local.x);
    case SB_TET10:
        quality = sbi_mesh_tet_quality(local.x);
        return quality > 0 ? quality * sbi_mesh_jacobian_ratio(table, local.x) : quality;
    case SB_HEX8: return sbi_mesh_box_quality(table, 8, local.x);
    case SB_QUAD4: return sbi_mesh_box_quality(table, 4, local.x);
    case SB_TRI3:
    case SB_TRI6: return sbi_mesh_triangle_quality(local.x);
    case SB_NO_ELEMENT: break;
    }
    return 0;
}

SB_API sb_real sb_mesh_element_quality(const sb_mesh *mesh, int element)
{
    sbi_mesh_table table;
    if (!sbi_mesh_has_element(mesh, element))
        return 0;
    sbi_mesh_table_for_checks(&table, mesh->element_type);
    return sbi_mesh_quality_of(mesh, &table, element);
}

/* ---- the report ---- */

SB_API void sb_mesh_report_free(sb_mesh_report *report)
{
    if (!report)
        return;
    sbi_free(&report->allocator, report->bad);
    memset(report, 0, sizeof *report);
}

/* Scratch of a check, released in one place. */
typedef struct sbi_mesh_check_scratch {
    unsigned char *defect; /* [elements] sb_mesh_defect */
    unsigned char *skip;   /* [elements] 1: no part in the topology */
    int *per_node;         /* [nodes] */
    int *per_element;      /* [elements] */
    sbi_mesh_keys sides, whole;
} sbi_mesh_check_scratch;

static void sbi_mesh_check_release(const sb_allocator *allocator, sbi_mesh_check_scratch *scratch)
{
    sbi_free(allocator, scratch->defect);
    sbi_free(allocator, scratch->skip);
    sbi_free(allocator, scratch->per_node);
    sbi_free(allocator, scratch->per_element);
    sbi_mesh_keys_free(allocator, &scratch->sides);
    sbi_mesh_keys_free(allocator, &scratch->whole);
}

static int sbi_mesh_check_allocate(const sb_mesh *mesh, const sb_allocator *allocator,
                                   sbi_mesh_check_scratch *scratch)
{
    memset(scratch, 0, sizeof *scratch);
    scratch->defect = (unsigned char *)sbi_alloc(allocator, (size_t)mesh->element_count, 1);
    scratch->skip = (unsigned char *)sbi_alloc(allocator, (size_t)mesh->element_count, 1);
    scratch->per_node = (int *)sbi_alloc(allocator, (size_t)mesh->node_count, sizeof(int));
    scratch->per_element = (int *)sbi_alloc(allocator, (size_t)mesh->element_count, sizeof(int));
    return scratch->defect && scratch->skip && scratch->per_node && scratch->per_element;
}

/* Sorts out the elements: what each has by itself, then the repetitions of earlier ones. */
static int sbi_mesh_check_elements(const sb_mesh *mesh, const sb_allocator *allocator,
                                   sbi_mesh_check_scratch *scratch)
{
    sbi_mesh_table table;
    sbi_mesh_keys *whole = &scratch->whole;
    sbi_mesh_table_for_checks(&table, mesh->element_type);
    for (int e = 0; e < mesh->element_count; e++) {
        sb_mesh_defect defect = sbi_mesh_element_defect(mesh, &table, e);
        scratch->defect[e] = (unsigned char)defect;
        scratch->skip[e] = defect == SB_MESH_INDEX_RANGE || defect == SB_MESH_REPEATED_NODE;
    }
    if (!sbi_mesh_keys_make(mesh, SBI_MESH_WHOLE, scratch->skip, allocator, whole))
        return 0;
    for (int begin = 0, end; begin < whole->sorted; begin = end) {
        end = sbi_mesh_run_end(whole, begin);
        for (int i = begin + 1; i < end; i++)
            if (scratch->defect[whole->order[i]] == SB_MESH_SOUND)
                scratch->defect[whole->order[i]] = SB_MESH_DUPLICATE;
    }
    return 1;
}

static int sbi_mesh_check_list_bad(const sb_mesh *mesh, const unsigned char *defect, sb_mesh_report *report)
{
    for (int e = 0; e < mesh->element_count; e++)
        report->defect_count[defect[e]]++;
    report->bad_count = mesh->element_count - report->defect_count[SB_MESH_SOUND];
    report->bad = (sb_mesh_bad_element *)sbi_alloc(&report->allocator, (size_t)report->bad_count,
                                                   sizeof(sb_mesh_bad_element));
    if (!report->bad)
        return 0;
    for (int e = 0, i = 0; e < mesh->element_count; e++) {
        if (defect[e] != SB_MESH_SOUND) {
            report->bad[i].element = e;
            report->bad[i++].defect = (sb_mesh_defect)defect[e];
        }
    }
    return 1;
}

static int sbi_mesh_check_nodes_of_report(const sb_mesh *mesh, const sb_allocator *allocator,
                                          sbi_mesh_check_scratch *scratch, sb_mesh_report *report)
{
    int n = sb_element_node_count(mesh->element_type), *used = scratch->per_node;
    report->first_not_finite_node = report->first_unreferenced_node = -1;
    memset(used, 0, sizeof(int) * (size_t)mesh->node_count);
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = sbi_mesh_element(mesh, e);
        for (int a = 0; a < n; a++)
            if (nodes[a] >= 0 && nodes[a] < mesh->node_count)
                used[nodes[a]] = 1;
    }
    for (int v = mesh->node_count - 1; v >= 0; v--) {
        if (!used[v])
            report->unreferenced_nodes++, report->first_unreferenced_node = v;
        if (!sb_v3_is_finite(mesh->nodes[v]))
            report->not_finite_nodes++, report->first_not_finite_node = v;
    }
    report->duplicate_nodes = sbi_mesh_find_duplicates(mesh, -1, allocator, scratch->per_node);
    return report->duplicate_nodes >= 0;
}

/* 1 when the element runs through its edge `side` from the smaller node to the larger. */
static int sbi_mesh_edge_ascends(const sb_mesh *mesh, int element, int side)
{
    const int *nodes = sbi_mesh_element(mesh, element);
    int ends[3] = {0, 0, 0};
    sb_element_edge(mesh->element_type, side, ends);
    return nodes[ends[0]] < nodes[ends[1]];
}

static void sbi_mesh_check_sides(const sb_mesh *mesh, const sbi_mesh_keys *sides, sb_mesh_report *report)
{
    int surface = sb_element_dimension(mesh->element_type) == 2;
    for (int begin = 0, end; begin < sides->sorted; begin = end) {
        end = sbi_mesh_run_end(sides, begin);
        if (end == begin + 1)
            (*(surface ? &report->open_edges : &report->boundary_faces))++;
        if (end > begin + 2)
            (*(surface ? &report->nonmanifold_edges : &report->nonmanifold_faces))++;
        if (surface && end == begin + 2) {
            int p = sides->order[begin], q = sides->order[begin + 1], per = sides->per_element;
            report->inconsistent_edges += sbi_mesh_edge_ascends(mesh, p / per, p % per) ==
                                          sbi_mesh_edge_ascends(mesh, q / per, q % per);
        }
    }
}

/* Corners of surface elements that share an edge form fans around its ends; a node with two fans is where
 * parts touch in a point only. Corner c of element e is number e * corners + c; edge i joins corners i and i
 * + 1. */
static int sbi_mesh_count_pinched(const sb_mesh *mesh, const sbi_mesh_keys *sides, const unsigned char *skip,
                                  const sb_allocator *allocator, int *fans)
{
    int corners = sides->per_element, pinched = 0;
    int *parent = (int *)sbi_alloc(allocator, (size_t)sides->count, sizeof(int));
    if (!parent)
        return -1;
    for (int i = 0; i < sides->count; i++)
        parent[i] = i;
    for (int begin = 0, end; begin < sides->sorted; begin = end) {
        int p = sides->order[begin], p_up = sbi_mesh_edge_ascends(mesh, p / corners, p % corners);
        end = sbi_mesh_run_end(sides, begin);
        for (int i = begin + 1; i < end; i++) {
            int q = sides->order[i], q_up = sbi_mesh_edge_ascends(mesh, q / corners, q % corners);
            int p_next = p - p % corners + (p % corners + 1) % corners;
            int q_next = q - q % corners + (q % corners + 1) % corners;
            sbi_mesh_unite(parent, p, p_up == q_up ? q : q_next);
            sbi_mesh_unite(parent, p_next, p_up == q_up ? q_next : q);
        }
    }
    memset(fans, 0, sizeof(int) * (size_t)mesh->node_count);
    for (int i = 0; i < sides->count; i++)
        if (!skip[i / corners] && parent[i] == i)
            pinched += ++fans[sbi_mesh_element(mesh, i / corners)[i % corners]] == 2;
    sbi_free(allocator, parent);
    return pinched;
}

static void sbi_mesh_check_edge_lengths(const sb_mesh *mesh, const unsigned char *defect,
                                        sb_mesh_report *report)
{
    int ends[3] = {0, 0, 0}, found = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = sbi_mesh_element(mesh, e);
        if (defect[e] >= SB_MESH_INDEX_RANGE && defect[e] <= SB_MESH_REPEATED_NODE)
            continue;
        for (int i = 0; sb_element_edge(mesh->element_type, i, ends); i++) {
            sb_real length = sb_v3_norm(sb_v3_sub(mesh->nodes[nodes[ends[1]]], mesh->nodes[nodes[ends[0]]]));
            report->min_edge = found ? sb_min(report->min_edge, length) : length;
            report->max_edge = found ? sb_max(report->max_edge, length) : length;
            found = 1;
        }
    }
}

static void sbi_mesh_check_geometry(const sb_mesh *mesh, const unsigned char *defect, sb_mesh_report *report)
{
    sbi_mesh_table table;
    double area, volume;
    report->worst_element = -1;
    sbi_mesh_table_for_checks(&table, mesh->element_type);
    for (int e = 0; e < mesh->element_count; e++) {
        sb_real quality = defect[e] == SB_MESH_SOUND ? sbi_mesh_quality_of(mesh, &table, e) : (sb_real)0;
        if (defect[e] == SB_MESH_SOUND && (report->worst_element < 0 || quality < report->worst_quality)) {
            report->worst_element = e;
            report->worst_quality = quality;
        }
    }
    sbi_mesh_measure(mesh, defect, &area, &volume);
    report->area = (sb_real)area;
    report->volume = (sb_real)volume;
    sbi_mesh_check_edge_lengths(mesh, defect, report);
}

/* Fills the report; 0 when memory is short. */
static int sbi_mesh_check_all(const sb_mesh *mesh, const sb_allocator *allocator,
                              sbi_mesh_check_scratch *scratch, sb_mesh_report *report)
{
    if (!sbi_mesh_check_allocate(mesh, allocator, scratch) ||
        !sbi_mesh_check_elements(mesh, allocator, scratch) ||
        !sbi_mesh_check_nodes_of_report(mesh, allocator, scratch, report) ||
        !sbi_mesh_keys_make(mesh, SBI_MESH_SIDES, scratch->skip, allocator, &scratch->sides))
        return 0;
    sbi_mesh_check_geometry(mesh, scratch->defect, report);
    sbi_mesh_check_sides(mesh, &scratch->sides, report);
    report->components =
        sbi_mesh_label_components(mesh, scratch->skip, scratch->per_element, scratch->per_node);
    if (sb_element_dimension(mesh->element_type) == 2)
        report->nonmanifold_vertices =
            sbi_mesh_count_pinched(mesh, &scratch->sides, scratch->skip, allocator, scratch->per_node);
    return report->nonmanifold_vertices >= 0 && sbi_mesh_check_list_bad(mesh, scratch->defect, report);
}

SB_API sb_result sb_mesh_check(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh_report *report,
                               sb_error *error)
{
    sb_mesh_report made;
    sbi_mesh_check_scratch scratch;
    sb_result result = sbi_mesh_check_shape(mesh, error);
    if (result == SB_ERROR_MESH)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "nothing to check: the mesh is empty");
    if (result == SB_OK && !report)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "report is NULL");
    if (result != SB_OK)
        return result;
    memset(&made, 0, sizeof made);
    sbi_mesh_set_allocator(&made.allocator, allocator);
    if (sbi_mesh_check_all(mesh, allocator, &scratch, &made))
        *report = made;
    else
        result = sbi_mesh_no_memory(error);
    sbi_mesh_check_release(allocator, &scratch);
    return result;
}

/* ---- repairs: orientation ---- */

static void sbi_mesh_swap(int *nodes, int a, int b)
{
    int keep = nodes[a];
    nodes[a] = nodes[b];
    nodes[b] = keep;
}

/* Mirrors an element's numbering; mid-edge nodes stay on their edges. */
static void sbi_mesh_mirror(sb_element_type type, int *nodes)
{
    switch (type) {
    case SB_TRI6:
        sbi_mesh_swap(nodes, 1, 2);
        sbi_mesh_swap(nodes, 3, 5); /* edges 01 and 20 */
        break;
    case SB_QUAD4: sbi_mesh_swap(nodes, 1, 3); break;
    case SB_TET10:
        sbi_mesh_swap(nodes, 1, 2);
        sbi_mesh_swap(nodes, 4, 6); /* edges 01 and 02 */
        sbi_mesh_swap(nodes, 8, 9); /* edges 13 and 23 */
        break;
    case SB_TRI3:
    case SB_TET4: sbi_mesh_swap(nodes, 1, 2); break;
    case SB_HEX8:
        for (int a = 0; a < 4; a++)
            sbi_mesh_swap(nodes, a, a + 4);
        break;
    case SB_NO_ELEMENT: break;
    }
}

static int *sbi_mesh_element_to_edit(sb_mesh *mesh, int element)
{
    return mesh->elements + (size_t)element * (size_t)sb_element_node_count(mesh->element_type);
}

/* Sign of the straight-sided volume without over- or underflow. */
static int sbi_mesh_is_inverted(const sb_mesh *mesh, const sbi_mesh_table *table, int element)
{
    sbi_mesh_local local;
    sb_real volume = 0;
    sbi_mesh_local_make(mesh, element, &local);
    if (mesh->element_type != SB_HEX8)
        return sbi_mesh_corner_det(local.x) < 0;
    for (int i = 0; i < table->count; i++)
        volume += sb_m3_det(sbi_mesh_jacobian(table, i, 8, local.x));
    return volume < 0;
}

SB_API sb_result sb_mesh_orient(sb_mesh *mesh, int *flipped, sb_error *error)
{
    sbi_mesh_table table;
    int count = 0;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    if (sb_element_dimension(mesh->element_type) == 2)
        return sb_mesh_orient_surface(mesh, flipped, error);
    sbi_mesh_table_for_volume(&table, mesh->element_type);
    for (int e = 0; e < mesh->element_count; e++) {
        if (sbi_mesh_is_inverted(mesh, &table, e)) {
            sbi_mesh_mirror(mesh->element_type, sbi_mesh_element_to_edit(mesh, e));
            count++;
        }
    }
    if (flipped)
        *flipped = count;
    return SB_OK;
}

/* Flooding of a surface: flip[e] is -1 before element e is reached. */
typedef struct sbi_mesh_flood {
    sbi_mesh_keys sides;
    int *mate;         /* [sides] */
    int *queue;        /* [elements] reached elements, part by part */
    signed char *flip; /* [elements] 1: to be mirrored */
} sbi_mesh_flood;

/* Reaches everything connected to element queue[begin] over edges of two elements. Returns the end of the
 * part in the queue, or -1 when the part is one-sided. */
static int sbi_mesh_flood_part(const sb_mesh *mesh, sbi_mesh_flood *flood, int begin)
{
    int end = begin + 1, per = flood->sides.per_element;
    flood->flip[flood->queue[begin]] = 0;
    for (int i = begin; i < end; i++) {
        int e = flood->queue[i];
        for (int side = 0; side < per; side++) {
            int mate = flood->mate[e * per + side], other = mate / per, clash, flip;
            if (mate < 0)
                continue;
            clash = sbi_mesh_edge_ascends(mesh, e, side) == sbi_mesh_edge_ascends(mesh, other, mate % per);
            flip = flood->flip[e] ^ clash;
            if (flood->flip[other] < 0) {
                flood->flip[other] = (signed char)flip;
                flood->queue[end++] = other;
            } else if (flood->flip[other] != flip) {
                return -1;
            }
        }
    }
    return end;
}

/* Decides whether the whole part queue[begin..end) must be mirrored on top, and returns its number of
 * flips. */
static int sbi_mesh_flood_turn(const sb_mesh *mesh, const sbi_mesh_table *table, sbi_mesh_flood *flood,
                               int begin, int end)
{
    int per = flood->sides.per_element, closed = 1, flips = 0, turn;
    double volume = 0, scale = 0, area, flux;
    sb_vec3 origin = mesh->nodes[sbi_mesh_element(mesh, flood->queue[begin])[0]];
    for (int i = begin; i < end; i++) {
        int e = flood->queue[i];
        flips += flood->flip[e];
        for (int side = 0; side < per; side++)
            closed = closed && flood->mate[e * per + side] >= 0;
        sbi_mesh_area_and_flux(mesh, table, e, origin, &area, &flux);
        volume += flood->flip[e] ? -flux : flux;
        scale += flux < 0 ? -flux : flux;
    }
    if (closed && (volume > 64 * (double)SB_EPSILON * scale || volume < -64 * (double)SB_EPSILON * scale))
        turn = volume < 0;
    else
        turn = flips > (end - begin) / 2;
    for (int i = begin; turn && i < end; i++)
        flood->flip[flood->queue[i]] ^= 1;
    return turn ? end - begin - flips : flips;
}

/* Returns the number of elements to mirror, or -1 for a one-sided surface. */
static int sbi_mesh_flood_all(const sb_mesh *mesh, sbi_mesh_flood *flood)
{
    sbi_mesh_table table;
    int count = 0, end = 0;
    sbi_mesh_table_for_volume(&table, mesh->element_type);
    memset(flood->flip, -1, (size_t)mesh->element_count);
    for (int e = 0; e < mesh->element_count; e++) {
        int begin = end;
        if (flood->flip[e] >= 0)
            continue;
        flood->queue[begin] = e;
        end = sbi_mesh_flood_part(mesh, flood, begin);
        if (end < 0)
            return -1;
        count += sbi_mesh_flood_turn(mesh, &table, flood, begin, end);
    }
    return count;
}

SB_API sb_result sb_mesh_orient_surface(sb_mesh *mesh, int *flipped, sb_error *error)
{
    sbi_mesh_flood flood;
    int count = -1;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    if (sb_element_dimension(mesh->element_type) != 2)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a mesh of %s is not a surface",
                        sb_element_name(mesh->element_type));
    memset(&flood, 0, sizeof flood);
    flood.queue = (int *)sbi_alloc(&mesh->allocator, (size_t)mesh->element_count, sizeof(int));
    flood.flip = (signed char *)sbi_alloc(&mesh->allocator, (size_t)mesh->element_count, 1);
    if (sbi_mesh_keys_make(mesh, SBI_MESH_SIDES, NULL, &mesh->allocator, &flood.sides))
        flood.mate = sbi_mesh_mates(&flood.sides, &mesh->allocator);
    if (!flood.queue || !flood.flip || !flood.mate) {
        result = sbi_mesh_no_memory(error);
    } else {
        count = sbi_mesh_flood_all(mesh, &flood);
        if (count < 0)
            result = sbi_fail(error, SB_ERROR_MESH, "the surface is one-sided: it cannot be oriented");
    }
    for (int e = 0; result == SB_OK && e < mesh->element_count; e++)
        if (flood.flip[e])
            sbi_mesh_mirror(mesh->element_type, sbi_mesh_element_to_edit(mesh, e));
    if (result == SB_OK && flipped)
        *flipped = count;
    sbi_free(&mesh->allocator, flood.queue);
    sbi_free(&mesh->allocator, flood.flip);
    sbi_free(&mesh->allocator, flood.mate);
    sbi_mesh_keys_free(&mesh->allocator, &flood.sides);
    return result;
}

/* ---- repairs: removing nodes and elements ---- */

/* Keeps the nodes with keep[v] == v in their order and points every index i at node keep[i]; keep is
 * overwritten. keep[v] <= v. Returns the number of nodes removed. */
static int sbi_mesh_compact_nodes(sb_mesh *mesh, int *keep)
{
    size_t indices = (size_t)mesh->element_count * (size_t)sb_element_node_count(mesh->element_type);
    int kept = 0, removed;
    for (int v = 0; v < mesh->node_count; v++) {
        if (keep[v] == v) {
            mesh->nodes[kept] = mesh->nodes[v];
            keep[v] = kept++;
        } else if (keep[v] >= 0) {
            keep[v] = keep[keep[v]]; /* its representative comes before it and has its new number */
        }
    }
    for (size_t i = 0; i < indices; i++)
        mesh->elements[i] = keep[mesh->elements[i]];
    removed = mesh->node_count - kept;
    mesh->node_count = kept;
    return removed;
}

SB_API sb_result sb_mesh_merge_nodes(sb_mesh *mesh, sb_real tolerance, int *merged, sb_error *error)
{
    int *keep, count;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    if (!sb_is_finite(tolerance))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the merge tolerance is not finite");
    keep = (int *)sbi_alloc(&mesh->allocator, (size_t)mesh->node_count, sizeof(int));
    count = keep ? sbi_mesh_find_duplicates(mesh, tolerance, &mesh->allocator, keep) : -1;
    if (count < 0)
        result = sbi_mesh_no_memory(error);
    else if (count > 0)
        sbi_mesh_compact_nodes(mesh, keep);
    if (result == SB_OK && merged)
        *merged = count;
    sbi_free(&mesh->allocator, keep);
    return result;
}

SB_API sb_result sb_mesh_remove_unreferenced(sb_mesh *mesh, int *removed, sb_error *error)
{
    int *keep, count;
    size_t indices;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    keep = (int *)sbi_alloc(&mesh->allocator, (size_t)mesh->node_count, sizeof(int));
    if (!keep)
        return sbi_mesh_no_memory(error);
    indices = (size_t)mesh->element_count * (size_t)sb_element_node_count(mesh->element_type);
    for (int v = 0; v < mesh->node_count; v++)
        keep[v] = -1;
    for (size_t i = 0; i < indices; i++)
        keep[mesh->elements[i]] = mesh->elements[i];
    count = sbi_mesh_compact_nodes(mesh, keep);
    if (removed)
        *removed = count;
    sbi_free(&mesh->allocator, keep);
    return SB_OK;
}

/* Keeps the elements that `drop` does not mark, with their regions. */
static void sbi_mesh_compact_elements(sb_mesh *mesh, const unsigned char *drop)
{
    size_t n = (size_t)sb_element_node_count(mesh->element_type);
    int kept = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        if (drop[e])
            continue;
        memmove(mesh->elements + (size_t)kept * n, mesh->elements + (size_t)e * n, sizeof(int) * n);
        if (mesh->regions)
            mesh->regions[kept] = mesh->regions[e];
        kept++;
    }
    mesh->element_count = kept;
}

SB_API sb_result sb_mesh_remove_duplicate_elements(sb_mesh *mesh, int *removed, sb_error *error)
{
    sbi_mesh_keys whole;
    unsigned char *drop;
    int count = 0;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    drop = (unsigned char *)sbi_alloc_zeroed(&mesh->allocator, (size_t)mesh->element_count, 1);
    if (!drop || !sbi_mesh_keys_make(mesh, SBI_MESH_WHOLE, NULL, &mesh->allocator, &whole)) {
        sbi_free(&mesh->allocator, drop);
        return sbi_mesh_no_memory(error);
    }
    for (int begin = 0, end; begin < whole.sorted; begin = end) {
        end = sbi_mesh_run_end(&whole, begin);
        for (int i = begin + 1; i < end; i++)
            drop[whole.order[i]] = 1;
        count += end - begin - 1;
    }
    sbi_mesh_compact_elements(mesh, drop);
    if (removed)
        *removed = count;
    sbi_mesh_keys_free(&mesh->allocator, &whole);
    sbi_free(&mesh->allocator, drop);
    return SB_OK;
}

SB_API sb_result sb_mesh_scale(sb_mesh *mesh, sb_real factor, sb_error *error)
{
    sb_result result = sbi_mesh_check_shape(mesh, error);
    if (result == SB_OK)
        result = sbi_mesh_check_nodes(mesh, error);
    if (result != SB_OK)
        return result;
    if (!(factor > 0) || !sb_is_finite(factor))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the scale factor must be positive and finite");
    for (int v = 0; v < mesh->node_count; v++)
        if (!sb_is_finite(factor * sbi_mesh_max_abs(mesh->nodes[v])))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, v, "node %d would not be finite after scaling",
                                 v);
    for (int v = 0; v < mesh->node_count; v++)
        mesh->nodes[v] = sb_v3_scale(factor, mesh->nodes[v]);
    return SB_OK;
}

/* ---- topology ---- */

SB_API void sb_index_table_free(sb_index_table *table)
{
    if (!table)
        return;
    sbi_free(&table->allocator, table->items);
    memset(table, 0, sizeof *table);
}

SB_API void sb_index_lists_free(sb_index_lists *lists)
{
    if (!lists)
        return;
    sbi_free(&lists->allocator, lists->offsets);
    sbi_free(&lists->allocator, lists->items);
    memset(lists, 0, sizeof *lists);
}

SB_API void sb_boundary_free(sb_boundary *boundary)
{
    sb_allocator allocator;
    if (!boundary)
        return;
    allocator = boundary->surface.allocator;
    sbi_free(&allocator, boundary->elements);
    sbi_free(&allocator, boundary->faces);
    sbi_free(&allocator, boundary->nodes);
    sb_mesh_free(&boundary->surface);
    memset(boundary, 0, sizeof *boundary);
}

static int sbi_mesh_table_allocate(sb_index_table *table, int rows, int columns,
                                   const sb_allocator *allocator)
{
    sbi_mesh_set_allocator(&table->allocator, allocator);
    table->rows = rows;
    table->columns = columns;
    table->items = (int *)sbi_alloc(allocator, (size_t)rows, sizeof(int) * (size_t)columns);
    return table->items != NULL;
}

static sb_result sbi_mesh_check_output(const sb_mesh *mesh, const void *output, sb_error *error)
{
    if (!output)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the output is NULL");
    return sbi_mesh_check_arrays(mesh, error);
}

static int sbi_mesh_count_alone(const int *mate, int count)
{
    int alone = 0;
    for (int p = 0; p < count; p++)
        alone += mate[p] == SBI_MESH_ALONE;
    return alone;
}

/* Copies face `face` of element e to row `row` of the boundary. */
static void sbi_mesh_boundary_row(const sb_mesh *mesh, int e, int face, int row, sb_boundary *boundary)
{
    int local[SB_MAX_FACE_NODES];
    int n = sb_element_face(mesh->element_type, face, local, NULL);
    int *nodes = sbi_mesh_element_to_edit(&boundary->surface, row);
    for (int a = 0; a < n; a++)
        nodes[a] = sbi_mesh_element(mesh, e)[local[a]];
    boundary->elements[row] = e;
    boundary->faces[row] = face;
    if (mesh->regions)
        boundary->surface.regions[row] = mesh->regions[e];
}

/* The surface with all nodes of the volume; 0 when memory is short. */
static int sbi_mesh_boundary_make(const sb_mesh *mesh, const int *mate, int with_map,
                                  const sb_allocator *allocator, sb_boundary *boundary)
{
    int per = sb_element_face_count(mesh->element_type), sides = mesh->element_count * per;
    int rows = sbi_mesh_count_alone(mate, sides), row = 0, local[SB_MAX_FACE_NODES];
    sb_element_type face_type = SB_NO_ELEMENT;
    sb_element_face(mesh->element_type, 0, local, &face_type);
    if (!sbi_mesh_allocate(&boundary->surface, face_type, mesh->node_count, rows, mesh->regions != NULL,
                           allocator))
        return 0;
    boundary->elements = (int *)sbi_alloc(allocator, (size_t)rows, sizeof(int));
    boundary->faces = (int *)sbi_alloc(allocator, (size_t)rows, sizeof(int));
    if (with_map)
        boundary->nodes = (int *)sbi_alloc(allocator, (size_t)mesh->node_count, sizeof(int));
    if (!boundary->elements || !boundary->faces || (with_map && !boundary->nodes))
        return 0;
    memcpy(boundary->surface.nodes, mesh->nodes, sizeof(sb_vec3) * (size_t)mesh->node_count);
    for (int p = 0; p < sides; p++)
        if (mate[p] == SBI_MESH_ALONE)
            sbi_mesh_boundary_row(mesh, p / per, p % per, row++, boundary);
    return 1;
}

/* Drops the nodes that the surface does not use; keep: [node_count] scratch. */
static void sbi_mesh_boundary_compact(sb_boundary *boundary, int *keep)
{
    sb_mesh *surface = &boundary->surface;
    size_t indices = (size_t)surface->element_count * (size_t)sb_element_node_count(surface->element_type);
    int kept = 0;
    for (int v = 0; v < surface->node_count; v++)
        keep[v] = -1;
    for (size_t i = 0; i < indices; i++)
        keep[surface->elements[i]] = surface->elements[i];
    for (int v = 0; v < surface->node_count; v++)
        if (keep[v] == v)
            boundary->nodes[kept++] = v;
    sbi_mesh_compact_nodes(surface, keep);
}

SB_API sb_result sb_mesh_boundary(const sb_mesh *mesh, int compact, const sb_allocator *allocator,
                                  sb_boundary *boundary, sb_error *error)
{
    sb_boundary made;
    sbi_mesh_keys sides;
    int *mate = NULL, *keep = NULL, ok;
    sb_result result = sbi_mesh_check_output(mesh, boundary, error);
    if (result != SB_OK)
        return result;
    if (sb_element_dimension(mesh->element_type) != 3)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a mesh of %s has no boundary faces",
                        sb_element_name(mesh->element_type));
    memset(&made, 0, sizeof made);
    if (sbi_mesh_keys_make(mesh, SBI_MESH_SIDES, NULL, allocator, &sides))
        mate = sbi_mesh_mates(&sides, allocator);
    sbi_mesh_keys_free(allocator, &sides);
    if (compact)
        keep = (int *)sbi_alloc(allocator, (size_t)mesh->node_count, sizeof(int));
    ok = mate && (keep || !compact) && sbi_mesh_boundary_make(mesh, mate, compact, allocator, &made);
    if (ok && compact)
        sbi_mesh_boundary_compact(&made, keep);
    if (ok) {
        *boundary = made;
    } else {
        sbi_mesh_set_allocator(&made.surface.allocator, allocator);
        sb_boundary_free(&made);
        result = sbi_mesh_no_memory(error);
    }
    sbi_free(allocator, mate);
    sbi_free(allocator, keep);
    return result;
}

SB_API sb_result sb_mesh_neighbours(const sb_mesh *mesh, const sb_allocator *allocator,
                                    sb_index_table *neighbours, sb_error *error)
{
    sb_index_table made;
    sbi_mesh_keys sides;
    int per;
    sb_result result = sbi_mesh_check_output(mesh, neighbours, error);
    if (result != SB_OK)
        return result;
    if (!sbi_mesh_keys_make(mesh, SBI_MESH_SIDES, NULL, allocator, &sides))
        return sbi_mesh_no_memory(error);
    per = sides.per_element;
    sbi_mesh_set_allocator(&made.allocator, allocator);
    made.rows = mesh->element_count;
    made.columns = per;
    made.items = sbi_mesh_mates(&sides, allocator);
    for (int p = 0; made.items && p < sides.count; p++)
        made.items[p] = made.items[p] >= 0 ? made.items[p] / per : -1;
    if (made.items)
        *neighbours = made;
    else
        result = sbi_mesh_no_memory(error);
    sbi_mesh_keys_free(allocator, &sides);
    return result;
}

static int sbi_mesh_count_runs(const sbi_mesh_keys *keys)
{
    int runs = 0;
    for (int begin = 0; begin < keys->sorted; begin = sbi_mesh_run_end(keys, begin))
        runs++;
    return runs;
}

SB_API sb_result sb_mesh_edges(const sb_mesh *mesh, const sb_allocator *allocator, sb_index_table *edges,
                               sb_error *error)
{
    sb_index_table made;
    sbi_mesh_keys keys;
    int row = 0;
    sb_result result = sbi_mesh_check_output(mesh, edges, error);
    if (result != SB_OK)
        return result;
    if (!sbi_mesh_keys_make(mesh, SBI_MESH_EDGES, NULL, allocator, &keys))
        return sbi_mesh_no_memory(error);
    if (sbi_mesh_table_allocate(&made, sbi_mesh_count_runs(&keys), 2, allocator)) {
        for (int begin = 0; begin < keys.sorted; begin = sbi_mesh_run_end(&keys, begin), row++)
            memcpy(made.items + 2 * (size_t)row, keys.keys + 2 * (size_t)keys.order[begin], 2 * sizeof(int));
        *edges = made;
    } else {
        result = sbi_mesh_no_memory(error);
    }
    sbi_mesh_keys_free(allocator, &keys);
    return result;
}

/* Fills offsets and items; an element that repeats a node is listed once for it. last: [nodes] scratch of
 * -1. */
static void sbi_mesh_lists_fill(const sb_mesh *mesh, sb_index_lists *lists, int *last, int counting)
{
    int n = sb_element_node_count(mesh->element_type);
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = sbi_mesh_element(mesh, e);
        for (int a = 0; a < n; a++) {
            if (last[nodes[a]] == e)
                continue;
            last[nodes[a]] = e;
            if (counting)
                lists->offsets[nodes[a] + 1]++;
            else
                lists->items[lists->offsets[nodes[a]]++] = e;
        }
    }
}

static void sbi_mesh_fill_int(int *values, int count, int value)
{
    for (int i = 0; i < count; i++)
        values[i] = value;
}

/* Node to element lists; 0 when memory is short or the entries do not fit an int. */
static int sbi_mesh_lists_make(const sb_mesh *mesh, const sb_allocator *allocator, sb_index_lists *lists)
{
    int count = mesh->node_count, *last;
    memset(lists, 0, sizeof *lists);
    sbi_mesh_set_allocator(&lists->allocator, allocator);
    if (mesh->element_count > INT_MAX / sb_element_node_count(mesh->element_type))
        return 0;
    lists->count = count;
    last = (int *)sbi_alloc(allocator, (size_t)count, sizeof(int));
    lists->offsets = (int *)sbi_alloc_zeroed(allocator, (size_t)count + 1, sizeof(int));
    if (last && lists->offsets) {
        sbi_mesh_fill_int(last, count, -1);
        sbi_mesh_lists_fill(mesh, lists, last, 1);
        for (int v = 0; v < count; v++)
            lists->offsets[v + 1] += lists->offsets[v];
        lists->items = (int *)sbi_alloc(allocator, (size_t)lists->offsets[count], sizeof(int));
    }
    if (lists->items) {
        sbi_mesh_fill_int(last, count, -1);
        sbi_mesh_lists_fill(mesh, lists, last, 0);
        memmove(lists->offsets + 1, lists->offsets,
                sizeof(int) * (size_t)count); /* filling moved each to its end */
        lists->offsets[0] = 0;
    } else {
        sb_index_lists_free(lists);
    }
    sbi_free(allocator, last);
    return lists->items != NULL;
}

SB_API sb_result sb_mesh_node_elements(const sb_mesh *mesh, const sb_allocator *allocator,
                                       sb_index_lists *lists, sb_error *error)
{
    sb_index_lists made;
    sb_result result = sbi_mesh_check_output(mesh, lists, error);
    if (result != SB_OK)
        return result;
    if (!sbi_mesh_lists_make(mesh, allocator, &made))
        return sbi_mesh_no_memory(error);
    *lists = made;
    return SB_OK;
}

SB_API sb_result sb_mesh_components(const sb_mesh *mesh, const sb_allocator *allocator,
                                    sb_index_table *labels, int *count, sb_error *error)
{
    sb_index_table made;
    int *scratch, parts;
    sb_result result = sbi_mesh_check_output(mesh, labels, error);
    if (result != SB_OK)
        return result;
    scratch = (int *)sbi_alloc(allocator, (size_t)mesh->node_count, sizeof(int));
    if (scratch && sbi_mesh_table_allocate(&made, mesh->element_count, 1, allocator)) {
        parts = sbi_mesh_label_components(mesh, NULL, made.items, scratch);
        *labels = made;
        if (count)
            *count = parts;
    } else {
        result = sbi_mesh_no_memory(error);
    }
    sbi_free(allocator, scratch);
    return result;
}

/* ---- tet4 to tet10 ---- */

/* number[part]: node of each edge, numbered from `first` in the order the edges appear. Returns the end. A
 * run of equal keys starts with its smallest part, so that one is met first. */
static int sbi_mesh_number_edges(const sbi_mesh_keys *edges, int first, int *number)
{
    int next = first;
    for (int begin = 0, end; begin < edges->sorted; begin = end) {
        end = sbi_mesh_run_end(edges, begin);
        for (int i = begin; i < end; i++)
            number[edges->order[i]] = edges->order[begin];
    }
    for (int p = 0; p < edges->count; p++)
        number[p] = number[p] == p ? next++ : number[number[p]];
    return next;
}

static void sbi_mesh_tet10_fill(const sb_mesh *mesh, const int *number, sb_mesh *tet10)
{
    int ends[3] = {0, 0, 0};
    memcpy(tet10->nodes, mesh->nodes, sizeof(sb_vec3) * (size_t)mesh->node_count);
    if (mesh->regions)
        memcpy(tet10->regions, mesh->regions, sizeof(int) * (size_t)mesh->element_count);
    for (int e = 0; e < mesh->element_count; e++) {
        const int *from = sbi_mesh_element(mesh, e);
        int *to = sbi_mesh_element_to_edit(tet10, e);
        memcpy(to, from, 4 * sizeof(int));
        for (int i = 0; i < 6; i++) {
            sb_vec3 p, q;
            sb_element_edge(SB_TET4, i, ends);
            p = mesh->nodes[from[ends[0]]], q = mesh->nodes[from[ends[1]]];
            to[4 + i] = number[e * 6 + i];
            tet10->nodes[to[4 + i]] = sb_v3(p.x / 2 + q.x / 2, p.y / 2 + q.y / 2, p.z / 2 + q.z / 2);
        }
    }
}

SB_API sb_result sb_mesh_to_tet10(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *tet10,
                                  sb_error *error)
{
    sb_mesh made;
    sbi_mesh_keys edges;
    int *number = NULL, nodes = 0, ok = 0;
    sb_result result = sbi_mesh_check_output(mesh, tet10, error);
    if (result != SB_OK)
        return result;
    if (mesh->element_type != SB_TET4)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a mesh of %s cannot become tet10: tet4 is needed",
                        sb_element_name(mesh->element_type));
    if (sbi_mesh_keys_make(mesh, SBI_MESH_EDGES, NULL, allocator, &edges) &&
        sbi_mesh_count_runs(&edges) <= INT_MAX - mesh->node_count)
        number = (int *)sbi_alloc(allocator, (size_t)edges.count, sizeof(int));
    if (number) {
        nodes = sbi_mesh_number_edges(&edges, mesh->node_count, number);
        ok = sbi_mesh_allocate(&made, SB_TET10, nodes, mesh->element_count, mesh->regions != NULL, allocator);
    }
    if (ok) {
        sbi_mesh_tet10_fill(mesh, number, &made);
        *tet10 = made;
    } else {
        result = sbi_mesh_no_memory(error);
    }
    sbi_free(allocator, number);
    sbi_mesh_keys_free(allocator, &edges);
    return result;
}

/* ---- reverse Cuthill-McKee ----
 * George & Liu: number nodes breadth first from a node at an end of the graph, neighbours by ascending
 * degree, and reverse the order. Two nodes are neighbours when they share an element. */

typedef struct sbi_mesh_graph {
    const sb_mesh *mesh;
    sb_index_lists elements; /* of each node */
    int *degree; /* [nodes] elements of the node: cheap, and ordered much like the number of neighbours */
    int *mark;   /* [nodes] search that saw the node last */
    int search;
    int *order; /* [nodes] */
} sbi_mesh_graph;

static int sbi_mesh_graph_less(const sbi_mesh_graph *graph, int a, int b)
{
    return graph->degree[a] != graph->degree[b] ? graph->degree[a] < graph->degree[b] : a < b;
}

static void sbi_mesh_sift_down(const sbi_mesh_graph *graph, int *nodes, int root, int count)
{
    for (int child = 2 * root + 1; child < count; root = child, child = 2 * root + 1) {
        if (child + 1 < count && sbi_mesh_graph_less(graph, nodes[child], nodes[child + 1]))
            child++;
        if (!sbi_mesh_graph_less(graph, nodes[root], nodes[child]))
            return;
        sbi_mesh_swap(nodes, root, child);
    }
}

/* Heap sort by degree, then number: no worst case, no recursion. */
static void sbi_mesh_sort_by_degree(const sbi_mesh_graph *graph, int *nodes, int count)
{
    for (int i = count / 2 - 1; i >= 0; i--)
        sbi_mesh_sift_down(graph, nodes, i, count);
    for (int i = count - 1; i > 0; i--) {
        sbi_mesh_swap(nodes, 0, i);
        sbi_mesh_sift_down(graph, nodes, 0, i);
    }
}

/* Appends the unseen neighbours of a node to the order at `end`; returns the new end. */
static int sbi_mesh_graph_visit(sbi_mesh_graph *graph, int node, int end)
{
    int n = sb_element_node_count(graph->mesh->element_type), begin = end;
    for (int i = graph->elements.offsets[node]; i < graph->elements.offsets[node + 1]; i++) {
        const int *nodes = sbi_mesh_element(graph->mesh, graph->elements.items[i]);
        for (int a = 0; a < n; a++) {
            if (graph->mark[nodes[a]] != graph->search) {
                graph->mark[nodes[a]] = graph->search;
                graph->order[end++] = nodes[a];
            }
        }
    }
    sbi_mesh_sort_by_degree(graph, graph->order + begin, end - begin);
    return end;
}

/* Breadth-first order from `start`, written from position `begin`; *depth: levels; *last: begin of the last
 * level. Returns the end. */
static int sbi_mesh_graph_search(sbi_mesh_graph *graph, int start, int begin, int *depth, int *last)
{
    int end = begin + 1, level = begin;
    graph->search++;
    graph->mark[start] = graph->search;
    graph->order[begin] = start;
    *depth = 0;
    while (level < end) {
        int level_end = end;
        *last = level;
        ++*depth;
        for (; level < level_end; level++)
            end = sbi_mesh_graph_visit(graph, graph->order[level], end);
    }
    return end;
}

/* Numbers the part around `start` from position `begin`: from a far end, found by searching again from the
 * least connected node of the last level as long as that goes deeper (a few times: each search costs the
 * whole part). */
static int sbi_mesh_graph_number(sbi_mesh_graph *graph, int start, int begin)
{
    int depth, last, end = sbi_mesh_graph_search(graph, start, begin, &depth, &last);
    for (int attempt = 0; attempt < 6; attempt++) {
        int candidate = graph->order[last], deeper, before = start;
        for (int i = last + 1; i < end; i++)
            if (sbi_mesh_graph_less(graph, graph->order[i], candidate))
                candidate = graph->order[i];
        start = candidate;
        sbi_mesh_graph_search(graph, start, begin, &deeper, &last);
        if (deeper < depth) {
            sbi_mesh_graph_search(graph, before, begin, &deeper, &last);
            break;
        }
        if (deeper == depth)
            break;
        depth = deeper;
    }
    return end;
}

/* Parts are taken from their least connected node on, by ascending degree. */
static void sbi_mesh_graph_order(sbi_mesh_graph *graph, int *by_degree, int *done)
{
    int count = graph->mesh->node_count, end = 0;
    for (int v = 0; v < count; v++) {
        by_degree[v] = v;
        done[v] = 0;
        graph->mark[v] = 0;
        graph->degree[v] = graph->elements.offsets[v + 1] - graph->elements.offsets[v];
    }
    sbi_mesh_sort_by_degree(graph, by_degree, count);
    for (int i = 0; i < count; i++) {
        int begin = end;
        if (done[by_degree[i]])
            continue;
        end = sbi_mesh_graph_number(graph, by_degree[i], begin);
        for (int k = begin; k < end; k++)
            done[graph->order[k]] = 1;
    }
}

/* Scratch of a reordering. */
typedef struct sbi_mesh_renumbering {
    sbi_mesh_graph graph;
    int *node_map, *element_map, *start; /* [nodes], [elements], [nodes + 1] */
    sb_vec3 *nodes;
    int *elements;
    int *regions;
} sbi_mesh_renumbering;

static void sbi_mesh_renumbering_free(const sb_allocator *allocator, sbi_mesh_renumbering *r)
{
    sb_index_lists_free(&r->graph.elements);
    sbi_free(allocator, r->graph.degree);
    sbi_free(allocator, r->graph.mark);
    sbi_free(allocator, r->graph.order);
    sbi_free(allocator, r->node_map);
    sbi_free(allocator, r->element_map);
    sbi_free(allocator, r->start);
    sbi_free(allocator, r->nodes);
    sbi_free(allocator, r->elements);
    sbi_free(allocator, r->regions);
}

static int sbi_mesh_renumbering_allocate(const sb_mesh *mesh, sbi_mesh_renumbering *r)
{
    const sb_allocator *allocator = &mesh->allocator;
    size_t nodes = (size_t)mesh->node_count, elements = (size_t)mesh->element_count;
    memset(r, 0, sizeof *r);
    r->graph.mesh = mesh;
    r->graph.degree = (int *)sbi_alloc(allocator, nodes, sizeof(int));
    r->graph.mark = (int *)sbi_alloc(allocator, nodes, sizeof(int));
    r->graph.order = (int *)sbi_alloc(allocator, nodes, sizeof(int));
    r->node_map = (int *)sbi_alloc(allocator, nodes, sizeof(int));
    r->element_map = (int *)sbi_alloc(allocator, elements, sizeof(int));
    r->start = (int *)sbi_alloc(allocator, nodes + 1, sizeof(int));
    r->nodes = (sb_vec3 *)sbi_alloc(allocator, nodes, sizeof(sb_vec3));
    r->elements = (int *)sbi_alloc(allocator, elements,
                                   sizeof(int) * (size_t)sb_element_node_count(mesh->element_type));
    if (mesh->regions)
        r->regions = (int *)sbi_alloc(allocator, elements, sizeof(int));
    return r->graph.degree && r->graph.mark && r->graph.order && r->node_map && r->element_map && r->start &&
           r->nodes && r->elements && (r->regions || !mesh->regions) &&
           sbi_mesh_lists_make(mesh, allocator, &r->graph.elements);
}

/* New element numbers by lowest new node, ties by old number: a counting sort. */
static void sbi_mesh_renumber_elements(const sb_mesh *mesh, sbi_mesh_renumbering *r)
{
    int n = sb_element_node_count(mesh->element_type);
    memset(r->start, 0, sizeof(int) * ((size_t)mesh->node_count + 1));
    for (int e = 0; e < mesh->element_count; e++) {
        const int *nodes = sbi_mesh_element(mesh, e);
        int lowest = r->node_map[nodes[0]];
        for (int a = 1; a < n; a++)
            lowest = r->node_map[nodes[a]] < lowest ? r->node_map[nodes[a]] : lowest;
        r->element_map[e] = lowest;
        r->start[lowest + 1]++;
    }
    for (int v = 0; v < mesh->node_count; v++)
        r->start[v + 1] += r->start[v];
    for (int e = 0; e < mesh->element_count; e++)
        r->element_map[e] = r->start[r->element_map[e]]++;
}

static void sbi_mesh_renumbering_apply(sb_mesh *mesh, sbi_mesh_renumbering *r)
{
    size_t n = (size_t)sb_element_node_count(mesh->element_type);
    for (int v = 0; v < mesh->node_count; v++)
        r->nodes[r->node_map[v]] = mesh->nodes[v];
    for (int e = 0; e < mesh->element_count; e++) {
        for (size_t a = 0; a < n; a++)
            r->elements[(size_t)r->element_map[e] * n + a] = r->node_map[mesh->elements[(size_t)e * n + a]];
        if (mesh->regions)
            r->regions[r->element_map[e]] = mesh->regions[e];
    }
    memcpy(mesh->nodes, r->nodes, sizeof(sb_vec3) * (size_t)mesh->node_count);
    memcpy(mesh->elements, r->elements, sizeof(int) * n * (size_t)mesh->element_count);
    if (mesh->regions)
        memcpy(mesh->regions, r->regions, sizeof(int) * (size_t)mesh->element_count);
}

SB_API sb_result sb_mesh_reorder(sb_mesh *mesh, int *node_map, int *element_map, sb_error *error)
{
    sbi_mesh_renumbering r;
    sb_result result = sbi_mesh_check_arrays(mesh, error);
    if (result != SB_OK)
        return result;
    if (sbi_mesh_renumbering_allocate(mesh, &r)) {
        sbi_mesh_graph_order(&r.graph, r.node_map, r.start);
        for (int v = 0; v < mesh->node_count; v++)
            r.node_map[r.graph.order[v]] = mesh->node_count - 1 - v;
        sbi_mesh_renumber_elements(mesh, &r);
        sbi_mesh_renumbering_apply(mesh, &r);
        if (node_map)
            memcpy(node_map, r.node_map, sizeof(int) * (size_t)mesh->node_count);
        if (element_map)
            memcpy(element_map, r.element_map, sizeof(int) * (size_t)mesh->element_count);
    } else {
        result = sbi_mesh_no_memory(error);
    }
    sbi_mesh_renumbering_free(&mesh->allocator, &r);
    return result;
}

/* ==== src/softbody/meshgen.c ==== */
/* meshgen: blocks of cells for simple solids.
 *
 * Every generator numbers its nodes and lists its cells as hexahedra whose top nodes are numbered after
 * and in the same order as their bottom nodes. A hexahedron is cut into tets so that every one of its
 * quadrilaterals is halved by the diagonal through its lowest-numbered node: two cells then cut a common
 * face alike, however they lie. */

#include <limits.h>
#include <string.h>

/* ---- building ---- */

typedef struct sbi_meshgen_builder {
    sb_mesh mesh; /* tet4 or hex8; made tet10 at the end */
    int next;     /* elements written */
} sbi_meshgen_builder;

/* a * b for counts up to 2^31, held below 2^31 + 1 so that products can be chained and then compared. */
static int64_t sbi_meshgen_product(int64_t a, int64_t b)
{
    int64_t limit = (int64_t)INT_MAX + 1;
    return a * b < limit ? a * b : limit;
}

/* Checks the type and the counts, and makes the arrays. */
static sb_result sbi_meshgen_begin(sbi_meshgen_builder *builder, sb_element_type type, int64_t nodes,
                                   int64_t cells, const sb_allocator *allocator, sb_error *error)
{
    int64_t elements = sbi_meshgen_product(cells, type == SB_HEX8 ? 1 : 6);
    if (nodes > INT_MAX || elements > INT_MAX)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "too many cells: the nodes or elements do not fit an int");
    builder->next = 0;
    if (!sbi_mesh_allocate(&builder->mesh, type == SB_HEX8 ? SB_HEX8 : SB_TET4, (int)nodes, (int)elements, 0,
                           allocator))
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for a mesh of %d nodes", (int)nodes);
    return SB_OK;
}

static sb_result sbi_meshgen_check(sb_element_type type, const sb_mesh *mesh, sb_error *error)
{
    if (!mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "mesh is NULL");
    if (type != SB_TET4 && type != SB_TET10 && type != SB_HEX8)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "cannot generate elements of type %d", (int)type);
    return SB_OK;
}

static int sbi_meshgen_is_length(sb_real length) { return length > 0 && sb_is_finite(length); }

/* Hands the mesh over, as tet10 when that was asked for. */
static sb_result sbi_meshgen_finish(sbi_meshgen_builder *builder, sb_element_type type, sb_mesh *mesh,
                                    sb_error *error)
{
    sb_result result = SB_OK;
    sb_allocator allocator = builder->mesh.allocator;
    if (type == SB_TET10) {
        result = sb_mesh_to_tet10(&builder->mesh, &allocator, mesh, error);
        sb_mesh_free(&builder->mesh);
    } else {
        *mesh = builder->mesh;
    }
    return result;
}

static void sbi_meshgen_add_tet(sbi_meshgen_builder *builder, int even, int a, int b, int c, int d)
{
    int *nodes = builder->mesh.elements + 4 * (size_t)builder->next++;
    nodes[0] = a;
    nodes[1] = b;
    nodes[2] = even ? c : d;
    nodes[3] = even ? d : c;
}

/* Cuts the prism over triangle low[0..2] (counter-clockwise seen from its top high[0..2]) into 3 tets: with
 * the bottom sorted to p < q < r, the side diagonals run from p to q', p to r' and q to r'. */
static void sbi_meshgen_add_prism(sbi_meshgen_builder *builder, const int low[3], const int high[3])
{
    int p = low[0] < low[1] ? (low[0] < low[2] ? 0 : 2) : (low[1] < low[2] ? 1 : 2);
    int q = (p + 1) % 3, r = (p + 2) % 3, even = low[q] < low[r];
    if (!even)
        q = (p + 2) % 3, r = (p + 1) % 3;
    sbi_meshgen_add_tet(builder, even, low[p], low[q], low[r], high[r]);
    sbi_meshgen_add_tet(builder, even, low[p], low[q], high[r], high[q]);
    sbi_meshgen_add_tet(builder, even, low[p], high[p], high[q], high[r]);
}

/* One cell: bottom 0 to 3 counter-clockwise seen from the top 4 to 7. */
static void sbi_meshgen_add_cell(sbi_meshgen_builder *builder, const int cell[8])
{
    int first = 0;
    if (builder->mesh.element_type == SB_HEX8) {
        memcpy(builder->mesh.elements + 8 * (size_t)builder->next++, cell, 8 * sizeof(int));
        return;
    }
    for (int a = 1; a < 4; a++)
        first = cell[a] < cell[first] ? a : first;
    for (int half = 1; half <= 2; half++) {
        int low[3], high[3], corner[3];
        corner[0] = first;
        corner[1] = (first + half) % 4;
        corner[2] = (first + half + 1) % 4;
        for (int i = 0; i < 3; i++) {
            low[i] = cell[corner[i]];
            high[i] = cell[corner[i] + 4];
        }
        sbi_meshgen_add_prism(builder, low, high);
    }
}

/* The cell at (i, j, k) of a grid of nodes with x fastest, nx and ny nodes per row and column. */
static void sbi_meshgen_grid_cell(int i, int j, int k, int nx, int ny, int cell[8])
{
    int base = i + nx * (j + ny * k);
    cell[0] = base;
    cell[1] = base + 1;
    cell[2] = base + nx + 1;
    cell[3] = base + nx;
    for (int a = 0; a < 4; a++)
        cell[a + 4] = cell[a] + nx * ny;
}

/* ---- beam ---- */

SB_API sb_result sb_mesh_beam(sb_element_type type, int nx, int ny, int nz, sb_vec3 size,
                              const sb_allocator *allocator, sb_mesh *mesh, sb_error *error)
{
    sbi_meshgen_builder builder;
    int cell[8], v = 0;
    sb_result result = sbi_meshgen_check(type, mesh, error);
    if (result != SB_OK)
        return result;
    if (nx < 1 || ny < 1 || nz < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a beam of %d x %d x %d cells", nx, ny, nz);
    if (!sbi_meshgen_is_length(size.x) || !sbi_meshgen_is_length(size.y) || !sbi_meshgen_is_length(size.z))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the sizes of a beam must be positive and finite");
    result = sbi_meshgen_begin(
        &builder, type,
        sbi_meshgen_product(sbi_meshgen_product((int64_t)nx + 1, (int64_t)ny + 1), (int64_t)nz + 1),
        sbi_meshgen_product(sbi_meshgen_product(nx, ny), nz), allocator, error);
    if (result != SB_OK)
        return result;
    for (int k = 0; k <= nz; k++)
        for (int j = 0; j <= ny; j++)
            for (int i = 0; i <= nx; i++)
                builder.mesh.nodes[v++] =
                    sb_v3(size.x * ((sb_real)i / (sb_real)nx), size.y * ((sb_real)j / (sb_real)ny),
                          size.z * ((sb_real)k / (sb_real)nz));
    for (int k = 0; k < nz; k++)
        for (int j = 0; j < ny; j++)
            for (int i = 0; i < nx; i++) {
                sbi_meshgen_grid_cell(i, j, k, nx + 1, ny + 1, cell);
                sbi_meshgen_add_cell(&builder, cell);
            }
    return sbi_meshgen_finish(&builder, type, mesh, error);
}

/* ---- discs and balls ----
 * A round core of a square or cubic grid, with layers of cells between its surface and the circle or sphere,
 * so that no cell has two sides on the round surface and none gets flat. */

/* Cells over the core and layers around it, so many that all cells are about equally large; core + 2 layers =
 * cells over the diameter. */
typedef struct sbi_meshgen_round {
    int core, layers;
} sbi_meshgen_round;

static sbi_meshgen_round sbi_meshgen_round_of(int cells)
{
    sbi_meshgen_round round;
    round.layers = (cells + 3) / 5;
    round.core = cells - 2 * round.layers;
    return round;
}

/* Maps the cube [-1, 1]^3 to the unit ball, its surface to the sphere; in the plane z = 0 the square to the
 * disc. */
static sb_vec3 sbi_meshgen_to_ball(sb_vec3 u)
{
    const sb_real half = (sb_real)0.5, third = (sb_real)(1.0 / 3);
    sb_real xx = u.x * u.x, yy = u.y * u.y, zz = u.z * u.z;
    return sb_v3(u.x * sb_sqrt(1 - half * (yy + zz) + third * yy * zz),
                 u.y * sb_sqrt(1 - half * (zz + xx) + third * zz * xx),
                 u.z * sb_sqrt(1 - half * (xx + yy) + third * xx * yy));
}

/* Position in the unit ball of core grid point u in [-1, 1]^3 (t = 0), or of the layer point at fraction t on
 * the way from surface point u of the core to the sphere. The core is half as wide as the ball, between a
 * cube and a ball in shape. */
static sb_vec3 sbi_meshgen_round_point(sb_vec3 u, sb_real t)
{
    const sb_real cube = (sb_real)0.24, ball = (sb_real)0.30;
    sb_vec3 on_ball = sbi_meshgen_to_ball(u);
    sb_vec3 core = sb_v3_madd(sb_v3_scale(cube, u), ball, on_ball);
    return sb_v3_madd(sb_v3_scale(1 - t, core), t, on_ball);
}

/* Grid coordinate i of n as a number in [-1, 1]; exactly antisymmetric. */
static sb_real sbi_meshgen_centred(int i, int n) { return (sb_real)(2 * i - n) / (sb_real)n; }

/* Grid point number `step` of [0, 4 core) on the boundary of a core square, counter-clockwise from (0, 0). */
static void sbi_meshgen_loop_point(int step, int core, int *i, int *j)
{
    int side = step / core, along = step % core;
    *i = side == 0 ? along : (side == 1 ? core : (side == 2 ? core - along : 0));
    *j = side == 0 ? 0 : (side == 1 ? along : (side == 2 ? core : core - along));
}

static int sbi_meshgen_disc_nodes(sbi_meshgen_round round)
{
    return (round.core + 1) * (round.core + 1) + 4 * round.core * round.layers;
}

/* Unit disc: node numbers of its quads are those of the core grid, then ring by ring. */
static void sbi_meshgen_disc_points(sbi_meshgen_round round, sb_vec3 *points)
{
    int core = round.core, next = 0, i, j;
    for (j = 0; j <= core; j++)
        for (i = 0; i <= core; i++)
            points[next++] = sbi_meshgen_round_point(
                sb_v3(sbi_meshgen_centred(i, core), sbi_meshgen_centred(j, core), 0), 0);
    for (int ring = 1; ring <= round.layers; ring++) {
        for (int step = 0; step < 4 * core; step++) {
            sbi_meshgen_loop_point(step, core, &i, &j);
            points[next++] =
                sbi_meshgen_round_point(sb_v3(sbi_meshgen_centred(i, core), sbi_meshgen_centred(j, core), 0),
                                        (sb_real)ring / (sb_real)round.layers);
        }
    }
}

/* Node of the disc at step `step` of ring `ring`; ring 0 is the boundary of the core. */
static int sbi_meshgen_ring_node(sbi_meshgen_round round, int ring, int step)
{
    int i, j, core = round.core;
    step %= 4 * core;
    if (ring > 0)
        return (core + 1) * (core + 1) + (ring - 1) * 4 * core + step;
    sbi_meshgen_loop_point(step, core, &i, &j);
    return i + (core + 1) * j;
}

static void sbi_meshgen_add_extruded(sbi_meshgen_builder *builder, const int quad[4], int offset, int layer)
{
    int cell[8];
    for (int a = 0; a < 4; a++) {
        cell[a] = quad[a] + offset * layer;
        cell[a + 4] = cell[a] + offset;
    }
    sbi_meshgen_add_cell(builder, cell);
}

/* The cells of one layer of a cylinder. */
static void sbi_meshgen_disc_cells(sbi_meshgen_builder *builder, sbi_meshgen_round round, int layer)
{
    int core = round.core, nodes = sbi_meshgen_disc_nodes(round), quad[8];
    for (int j = 0; j < core; j++) {
        for (int i = 0; i < core; i++) {
            sbi_meshgen_grid_cell(i, j, 0, core + 1, core + 1, quad);
            sbi_meshgen_add_extruded(builder, quad, nodes, layer);
        }
    }
    for (int ring = 0; ring < round.layers; ring++) {
        for (int step = 0; step < 4 * core; step++) {
            quad[0] = sbi_meshgen_ring_node(round, ring, step);
            quad[1] = sbi_meshgen_ring_node(round, ring + 1, step);
            quad[2] = sbi_meshgen_ring_node(round, ring + 1, step + 1);
            quad[3] = sbi_meshgen_ring_node(round, ring, step + 1);
            sbi_meshgen_add_extruded(builder, quad, nodes, layer);
        }
    }
}

/* (u, v) across and w along coordinate axis `axis`; cyclic, so that orientation is kept. */
static sb_vec3 sbi_meshgen_along_axis(int axis, sb_real u, sb_real v, sb_real w)
{
    return axis == 0 ? sb_v3(w, u, v) : (axis == 1 ? sb_v3(v, w, u) : sb_v3(u, v, w));
}

/* Places the first layer's unit disc (in the node array already), then copies it up. */
static void sbi_meshgen_cylinder_nodes(sb_mesh *mesh, int per_layer, int axis, sb_real radius, sb_real length,
                                       int along)
{
    for (int k = along; k >= 0; k--) { /* from the top down: layer 0 is the source of all */
        sb_real height = length * ((sb_real)k / (sb_real)along);
        for (int v = 0; v < per_layer; v++) {
            sb_vec3 point = mesh->nodes[v];
            mesh->nodes[v + k * per_layer] =
                sbi_meshgen_along_axis(axis, radius * point.x, radius * point.y, height);
        }
    }
}

SB_API sb_result sb_mesh_cylinder(sb_element_type type, int axis, sb_real radius, sb_real length, int across,
                                  int along, const sb_allocator *allocator, sb_mesh *mesh, sb_error *error)
{
    sbi_meshgen_builder builder;
    sbi_meshgen_round round = sbi_meshgen_round_of(across);
    int64_t quads;
    sb_result result = sbi_meshgen_check(type, mesh, error);
    if (result != SB_OK)
        return result;
    if (axis < 0 || axis > 2)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "axis %d of a cylinder is none of 0, 1, 2", axis);
    if (across < 4 || across > 20000 || along < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a cylinder of %d cells across and %d along", across,
                        along);
    if (!sbi_meshgen_is_length(radius) || !sbi_meshgen_is_length(length))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "radius and length must be positive and finite");
    quads = (int64_t)round.core * round.core + 4 * (int64_t)round.core * round.layers;
    result = sbi_meshgen_begin(&builder, type,
                               sbi_meshgen_product(sbi_meshgen_disc_nodes(round), (int64_t)along + 1),
                               sbi_meshgen_product(quads, along), allocator, error);
    if (result != SB_OK)
        return result;
    sbi_meshgen_disc_points(round, builder.mesh.nodes);
    sbi_meshgen_cylinder_nodes(&builder.mesh, sbi_meshgen_disc_nodes(round), axis, radius, length, along);
    for (int layer = 0; layer < along; layer++)
        sbi_meshgen_disc_cells(&builder, round, layer);
    return sbi_meshgen_finish(&builder, type, mesh, error);
}

/* ---- balls ---- */

/* Number of a core grid point among those on the core's surface, in the order of the grid; -1 inside. */
static int *sbi_meshgen_surface_ranks(int core, const sb_allocator *allocator)
{
    int side = core + 1, next = 0, v = 0;
    int *rank = (int *)sbi_alloc(allocator, (size_t)side * (size_t)side * (size_t)side, sizeof(int));
    for (int k = 0; rank && k < side; k++)
        for (int j = 0; j < side; j++)
            for (int i = 0; i < side; i++, v++)
                rank[v] = i % core == 0 || j % core == 0 || k % core == 0 ? next++ : -1;
    return rank;
}

/* Nodes of the unit ball: the core grid, then layer after layer in the order of the core's surface. */
static void sbi_meshgen_ball_nodes(sbi_meshgen_round round, const int *rank, sb_vec3 *nodes)
{
    int core = round.core, side = core + 1, v = 0,
        surface = side * side * side - (core - 1) * (core - 1) * (core - 1);
    for (int k = 0; k < side; k++) {
        for (int j = 0; j < side; j++) {
            for (int i = 0; i < side; i++, v++) {
                sb_vec3 u = sb_v3(sbi_meshgen_centred(i, core), sbi_meshgen_centred(j, core),
                                  sbi_meshgen_centred(k, core));
                nodes[v] = sbi_meshgen_round_point(u, 0);
                for (int layer = 1; layer <= round.layers && rank[v] >= 0; layer++)
                    nodes[side * side * side + (layer - 1) * surface + rank[v]] =
                        sbi_meshgen_round_point(u, (sb_real)layer / (sb_real)round.layers);
            }
        }
    }
}

/* The cells between a quad on the core's surface (counter-clockwise from outside) and the sphere. */
static void sbi_meshgen_ball_column(sbi_meshgen_builder *builder, sbi_meshgen_round round, const int *rank,
                                    const int quad[4])
{
    int core = round.core, side = core + 1,
        surface = side * side * side - (core - 1) * (core - 1) * (core - 1);
    int cell[8];
    for (int a = 0; a < 4; a++)
        cell[a + 4] = quad[a];
    for (int layer = 1; layer <= round.layers; layer++) {
        for (int a = 0; a < 4; a++) {
            cell[a] = cell[a + 4];
            cell[a + 4] = side * side * side + (layer - 1) * surface + rank[quad[a]];
        }
        sbi_meshgen_add_cell(builder, cell);
    }
}

static void sbi_meshgen_ball_cells(sbi_meshgen_builder *builder, sbi_meshgen_round round, const int *rank)
{
    int core = round.core, cell[8], local[SB_MAX_FACE_NODES] = {0}, quad[4];
    for (int k = 0; k < core; k++) {
        for (int j = 0; j < core; j++) {
            for (int i = 0; i < core; i++) {
                int last = core - 1, outside[6];
                outside[0] = i == 0, outside[1] = i == last; /* the faces x-, x+, y-, y+, z-, z+ of hex8 */
                outside[2] = j == 0, outside[3] = j == last;
                outside[4] = k == 0, outside[5] = k == last;
                sbi_meshgen_grid_cell(i, j, k, core + 1, core + 1, cell);
                sbi_meshgen_add_cell(builder, cell);
                for (int face = 0; face < 6; face++) {
                    if (!outside[face])
                        continue;
                    sb_element_face(SB_HEX8, face, local, NULL);
                    for (int a = 0; a < 4; a++)
                        quad[a] = cell[local[a]];
                    sbi_meshgen_ball_column(builder, round, rank, quad);
                }
            }
        }
    }
}

/* The unit ball, with its nodes to be moved before it is finished. */
static sb_result sbi_meshgen_ball(sbi_meshgen_builder *builder, sb_element_type type, int cells,
                                  const sb_allocator *allocator, sb_error *error)
{
    sbi_meshgen_round round = sbi_meshgen_round_of(cells);
    int64_t core = round.core, side = core + 1, inner = core - 1;
    int64_t surface = side * side * side - inner * inner * inner;
    int *rank;
    sb_result result =
        sbi_meshgen_begin(builder, type, side * side * side + round.layers * surface,
                          core * core * core + 6 * core * core * round.layers, allocator, error);
    if (result != SB_OK)
        return result;
    rank = sbi_meshgen_surface_ranks(round.core, allocator);
    if (!rank) {
        sb_mesh_free(&builder->mesh);
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for a mesh of %d cells across", cells);
    }
    sbi_meshgen_ball_nodes(round, rank, builder->mesh.nodes);
    sbi_meshgen_ball_cells(builder, round, rank);
    sbi_free(allocator, rank);
    return SB_OK;
}

SB_API sb_result sb_mesh_ellipsoid(sb_element_type type, sb_vec3 semi_axes, int cells,
                                   const sb_allocator *allocator, sb_mesh *mesh, sb_error *error)
{
    sbi_meshgen_builder builder;
    sb_result result = sbi_meshgen_check(type, mesh, error);
    if (result != SB_OK)
        return result;
    if (cells < 4 || cells > 500)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "an ellipsoid of %d cells across: 4 to 500 are possible",
                        cells);
    if (!sbi_meshgen_is_length(semi_axes.x) || !sbi_meshgen_is_length(semi_axes.y) ||
        !sbi_meshgen_is_length(semi_axes.z))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the semi-axes must be positive and finite");
    result = sbi_meshgen_ball(&builder, type, cells, allocator, error);
    if (result != SB_OK)
        return result;
    for (int v = 0; v < builder.mesh.node_count; v++) {
        sb_vec3 *x = &builder.mesh.nodes[v];
        *x = sb_v3(semi_axes.x * x->x, semi_axes.y * x->y, semi_axes.z * x->z);
    }
    return sbi_meshgen_finish(&builder, type, mesh, error);
}

/* ---- organ ---- */

/* Bends the unit ball to a liver (m). Each line moves points along one axis only, by an amount that grows
 * with that coordinate, so nothing can turn inside out: a dome above and a flat underside; the right lobe
 * (negative x) thick and deep, the left thin; a notch in the front edge (negative y) between them; the whole
 * arched over the hollow below. */
static sb_vec3 sbi_meshgen_liver_point(sb_vec3 u)
{
    sb_real x = (sb_real)0.101 * u.x;
    sb_real thick = (sb_real)0.055 - (sb_real)0.012 * u.x, deep = (sb_real)0.0675 - (sb_real)0.010 * u.x;
    sb_real from_notch = (u.x - (sb_real)0.30) / (sb_real)0.55;
    sb_real in_notch = sb_max(1 - from_notch * from_notch, 0);
    sb_real y = deep * u.y + (sb_real)0.007 * in_notch * in_notch * (1 - u.y);
    sb_real z = thick * (u.z + (sb_real)0.28 * u.z * u.z);
    z -= (sb_real)0.0355 * u.x * u.x + (sb_real)0.010 * u.y * u.y;
    return sb_v3(x, y, z);
}

SB_API sb_result sb_mesh_organ(sb_element_type type, int cells, const sb_allocator *allocator, sb_mesh *mesh,
                               sb_error *error)
{
    sbi_meshgen_builder builder;
    sb_result result = sbi_meshgen_check(type, mesh, error);
    if (result != SB_OK)
        return result;
    if (cells < 4 || cells > 60)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "an organ of %d cells across: 4 to 60 are possible", cells);
    result = sbi_meshgen_ball(&builder, type, cells, allocator, error);
    if (result != SB_OK)
        return result;
    for (int v = 0; v < builder.mesh.node_count; v++)
        builder.mesh.nodes[v] = sbi_meshgen_liver_point(builder.mesh.nodes[v]);
    return sbi_meshgen_finish(&builder, type, mesh, error);
}

/* ==== src/softbody/meshio_reader.h ==== */
/* meshio_reader: what all mesh formats share, internal. A bounded reader that counts lines, exact number
 * parsing, and the loader that gathers nodes and cells of any kind. Part of the room meshio. */
#ifndef SB_MESHIO_READER_H
#define SB_MESHIO_READER_H


/* ---- numbers ---------------------------------------------------------------------------------------
 * strtod obeys the locale: where the decimal point is a comma it reads "0.5" as 0 and stops. These do not;
 * and all `length` characters must belong to the number. Both return 1, 0 (not a number) or -1. */

/* [+-]digits; -1: does not fit. */
SBI_API int sbi_parse_integer(const char *text, size_t length, int64_t *value);
/* [+-]digits[.digits][e[+-]digits], rounded correctly; -1: nan or infinite, as a word or by overflow. */
SBI_API int sbi_parse_real(const char *text, size_t length, double *value);

/* ---- reader ------------------------------------------------------------------------------------------- */

typedef struct sbi_reader {
    const char *data;
    size_t size;
    size_t at;         /* next byte, <= size */
    int line;          /* line of data[at], from 1 */
    int binary;        /* errors give the byte offset instead of the line */
    int big_endian;    /* byte order of the binary numbers */
    char comment;      /* character that starts a comment to the end of the line, or 0 */
    int continuation;  /* 1: a backslash at the end of a line joins the next one */
    int node, element; /* what is being read, for errors; -1: nothing */
    const char *name;  /* of the file */
    sb_error *error;
} sbi_reader;

/* A word of the file: characters up to the next blank. */
typedef struct sbi_word {
    const char *text;
    size_t length;
} sbi_word;

SBI_API void sbi_reader_init(sbi_reader *reader, const void *data, size_t size, const char *name,
                             sb_error *error);
/* Fills the reader's error with file, line or byte offset, node and element; returns result. */
SBI_API sb_result sbi_reader_fail(const sbi_reader *reader, sb_result result, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 3, 4)))
#endif
    ;
/* Copies a path into the error, cut at the front when it is too long. */
SBI_API void sbi_error_set_file(sb_error *error, const char *name);

SB_INLINE size_t sbi_reader_left(const sbi_reader *reader) { return reader->size - reader->at; }
/* Steps over blanks; 1 when the line or the file ends here. */
SBI_API int sbi_reader_at_line_end(sbi_reader *reader);
/* Steps over the rest of the line. */
SBI_API void sbi_reader_next_line(sbi_reader *reader);
/* The next word, on this line or on a later one; 0 at the end of the file. */
SBI_API int sbi_reader_word(sbi_reader *reader, sbi_word *word);
/* The next word on this line; 0 at its end. */
SBI_API int sbi_reader_line_word(sbi_reader *reader, sbi_word *word);
/* sbi_reader_word without moving. */
SBI_API int sbi_reader_peek(const sbi_reader *reader, sbi_word *word);
/* 1 when the word is `text`, whatever the case of its letters. */
SBI_API int sbi_word_is(sbi_word word, const char *text);
/* The word as a string for messages, cut to the buffer, strange characters replaced; returns buffer. */
SBI_API const char *sbi_word_print(sbi_word word, char buffer[32]);

/* The next word as a number; `what` names it in errors. */
SBI_API sb_result sbi_reader_integer(sbi_reader *reader, const char *what, int64_t *value);
SBI_API sb_result sbi_reader_real(sbi_reader *reader, const char *what, double *value);
/* A number of things that take at least `bytes` bytes each of what is left of the file: more than fit is
 * an error, so that memory may be taken for them. bytes 0: unchecked. At most INT_MAX. */
SBI_API sb_result sbi_reader_count(sbi_reader *reader, const char *what, size_t bytes, int *count);
SBI_API sb_result sbi_reader_check_count(const sbi_reader *reader, const char *what, int64_t value,
                                         size_t bytes, int *count);
/* Steps over `count` words. */
SBI_API sb_result sbi_reader_skip_words(sbi_reader *reader, size_t count, const char *what);

/* The next `count` * `size` bytes, or NULL with an error when there are fewer. */
SBI_API const unsigned char *sbi_reader_bytes(sbi_reader *reader, size_t count, size_t size,
                                              const char *what);
/* Binary numbers in the reader's byte order. */
SBI_API uint64_t sbi_decode_bits(const sbi_reader *reader, const unsigned char *bytes, int size);
SBI_API int64_t sbi_decode_signed(const sbi_reader *reader, const unsigned char *bytes, int size);
SBI_API double sbi_decode_float(const sbi_reader *reader, const unsigned char *bytes, int size);

/* Sorts `order` [count], stably, by before(context, a, b); scratch [count]. Merging, so that no input is
 * slow. */
typedef int (*sbi_before)(const void *context, int a, int b);
SBI_API void sbi_merge_sort(int *order, int *scratch, int count, sbi_before before, const void *context);

/* ---- cells ---------------------------------------------------------------------------------------- */

/* Rows of the table of cell kinds that the code names; the others are found by a format's own number. */
enum { SBI_CELL_TRI3 = 0, SBI_CELL_QUAD4 = 1, SBI_CELL_TET4 = 2, SBI_CELL_TET10 = 3, SBI_CELL_KINDS = 55 };

/* How a format lists the nodes of a cell, against ours (VTK's). */
typedef enum sbi_node_order {
    SBI_ORDER_SAME = 0,
    SBI_ORDER_PIXEL = 1, /* VTK's pixel: rows instead of round */
    SBI_ORDER_VOXEL = 2,
    SBI_ORDER_GMSH_TET10 = 3 /* the last two mid-edge nodes exchanged */
} sbi_node_order;

/* A kind of cell that some format knows. New element types: fill in `type` (and the order, if it is not
 * VTK's). */
typedef struct sbi_cell_kind {
    char name[24];
    sb_element_type type; /* SB_NO_ELEMENT: this library has no such element */
    int dimension;
    int nodes;     /* 0: any number */
    int vtk, gmsh; /* number of the kind in these formats; -1: none */
    sbi_node_order vtk_order, gmsh_order;
} sbi_cell_kind;
SBI_API const sbi_cell_kind *sbi_cell_kind_at(int kind);
/* Row of a format's number, or -1. */
SBI_API int sbi_cell_kind_of_vtk(int64_t number);
SBI_API int sbi_cell_kind_of_gmsh(int64_t number);

/* ---- loader --------------------------------------------------------------------------------------- */

/* A cell that may become an element; its nodes lie in `indices`, one cell after the other. */
typedef struct sbi_cell {
    int kind;
    int source; /* its number in the file; several triangles may come from one polygon */
    int region;
} sbi_cell;

/* Everything gathered from a file. */
typedef struct sbi_loader {
    sbi_reader reader;
    sb_allocator allocator;
    double scale;
    sb_vec3 *nodes;
    size_t node_count, node_capacity;
    int *indices;
    size_t index_count, index_capacity;
    sbi_cell *cells; /* surface and volume cells of supported types */
    size_t cell_count, cell_capacity;
    int *scratch; /* nodes of the cell being read */
    size_t scratch_count, scratch_capacity;
    int *source_regions; /* [source_count] regions by number in the file, or NULL: see sbi_cell */
    int source_count;    /* cells met in the file */
    int kind_count[SBI_CELL_KINDS];
    int kind_line[SBI_CELL_KINDS]; /* where the kind was met first */
    int kind_first[SBI_CELL_KINDS];
    int split_polygons, merged_vertices, skipped_cells;
} sbi_loader;

SBI_API void sbi_loader_init(sbi_loader *loader, const sb_load_options *options, sb_error *error);
SBI_API void sbi_loader_free(sbi_loader *loader);

/* An array for at least `needed` items with the `used` first ones of `old`, which is freed; NULL without
 * memory (old stays). Grows geometrically. */
SBI_API void *sbi_loader_grow(const sbi_loader *loader, void *old, size_t used, size_t *capacity,
                              size_t needed, size_t item);
SBI_API sb_result sbi_loader_no_memory(const sbi_loader *loader);

/* Takes memory for `count` more nodes, of which the caller knows that the file can hold them. */
SBI_API sb_result sbi_loader_reserve_nodes(sbi_loader *loader, int count);
/* Appends a node, scaled; a coordinate that is not finite or does not fit is an error. */
SBI_API sb_result sbi_loader_add_node(sbi_loader *loader, const double x[3]);
/* Reads three words as a node. */
SBI_API sb_result sbi_loader_read_node(sbi_loader *loader);

/* A cell: begin, then its nodes as numbered in the file (`base` is the first node's number), then end. */
SBI_API void sbi_loader_begin_cell(sbi_loader *loader);
SBI_API sb_result sbi_loader_cell_node(sbi_loader *loader, int64_t number, int64_t base);
SBI_API sb_result sbi_loader_end_cell(sbi_loader *loader, int kind, sbi_node_order order, int region);
/* Ends a cell that is a polygon: one tri3 or a fan of them. */
SBI_API sb_result sbi_loader_end_polygon(sbi_loader *loader, int region);
/* Ends a cell that is a strip of triangles, each with the last two nodes of the one before. */
SBI_API sb_result sbi_loader_end_strip(sbi_loader *loader, int region);

/* Makes the mesh of the cells with the highest dimension; its nodes are the loader's. Does not check
 * geometry. */
SBI_API sb_result sbi_loader_build(sbi_loader *loader, sb_mesh *mesh);

/* ---- formats ---------------------------------------------------------------------------------------
 * Each reads the whole file that the loader's reader holds into the loader. */
SBI_API sb_result sbi_vtk_read(sbi_loader *loader);
SBI_API sb_result sbi_gmsh_read(sbi_loader *loader);
SBI_API sb_result sbi_obj_read(sbi_loader *loader);
SBI_API sb_result sbi_stl_read(sbi_loader *loader);
SBI_API sb_result sbi_ply_read(sbi_loader *loader);
SBI_API sb_result sbi_off_read(sbi_loader *loader);
/* TetGen's two files, one after the other; between them the caller changes the reader. *base: number of
 * the first node. */
SBI_API sb_result sbi_tetgen_read_nodes(sbi_loader *loader, int64_t *base);
SBI_API sb_result sbi_tetgen_read_elements(sbi_loader *loader, int64_t base);
/* 1 when the size is that of a binary STL file with the count it claims. */
SBI_API int sbi_stl_is_binary(const char *data, size_t size);

#endif /* SB_MESHIO_READER_H */

/* ==== src/softbody/meshio_reader.c ==== */
/* meshio_reader: exact number parsing, the bounded reader and the loader that all mesh formats share. */

#include <float.h>
#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

/* ==== numbers ====================================================================================== */

SBI_API int sbi_parse_integer(const char *text, size_t length, int64_t *value)
{
    size_t i = length && (text[0] == '-' || text[0] == '+') ? 1 : 0;
    int negative = i && text[0] == '-';
    uint64_t limit = (uint64_t)INT64_MAX + (negative ? 1u : 0u), magnitude = 0;
    int fits = 1;
    if (i == length)
        return 0;
    for (; i < length; i++) {
        unsigned digit = (unsigned)(unsigned char)text[i] - '0';
        if (digit > 9)
            return 0;
        if (magnitude > (limit - digit) / 10)
            fits = 0;
        else
            magnitude = magnitude * 10 + digit;
    }
    if (!fits)
        return -1;
    *value = negative && magnitude ? -(int64_t)(magnitude - 1) - 1 : (int64_t)magnitude;
    return 1;
}

/* Unsigned integer of up to 3072 bits, least word first, no leading zero words; 0 has no words. */
enum { SBI_BIG_WORDS = 96 };
typedef struct sbi_big {
    uint32_t word[SBI_BIG_WORDS];
    int count;
} sbi_big;

/* a = a * factor + term */
static void sbi_big_multiply(sbi_big *a, uint32_t factor, uint32_t term)
{
    uint64_t carry = term;
    for (int i = 0; i < a->count; i++) {
        carry += (uint64_t)a->word[i] * factor;
        a->word[i] = (uint32_t)carry;
        carry >>= 32;
    }
    if (carry)
        a->word[a->count++] = (uint32_t)carry;
}

static void sbi_big_multiply_pow5(sbi_big *a, int power)
{
    const uint32_t pow5_13 = 1220703125u; /* the largest that fits */
    for (; power >= 13; power -= 13)
        sbi_big_multiply(a, pow5_13, 0);
    for (; power > 0; power--)
        sbi_big_multiply(a, 5, 0);
}

static int sbi_big_bits(const sbi_big *a)
{
    uint32_t top;
    int bits;
    if (a->count == 0)
        return 0;
    bits = (a->count - 1) * 32;
    for (top = a->word[a->count - 1]; top; top >>= 1)
        bits++;
    return bits;
}

static void sbi_big_shift_left(sbi_big *a, int bits)
{
    int words = bits / 32;
    if (bits % 32)
        sbi_big_multiply(a, (uint32_t)1 << (bits % 32), 0);
    if (words == 0 || a->count == 0)
        return;
    memmove(a->word + words, a->word, (size_t)a->count * sizeof a->word[0]);
    memset(a->word, 0, (size_t)words * sizeof a->word[0]);
    a->count += words;
}

/* a -= b and 1 when a >= b; else 0. */
static int sbi_big_take(sbi_big *a, const sbi_big *b)
{
    int64_t borrow = 0;
    int i = a->count - 1;
    if (a->count != b->count) {
        if (a->count < b->count)
            return 0;
    } else {
        while (i >= 0 && a->word[i] == b->word[i])
            i--;
        if (i >= 0 && a->word[i] < b->word[i])
            return 0;
    }
    for (i = 0; i < a->count; i++) {
        int64_t difference = (int64_t)a->word[i] - (i < b->count ? (int64_t)b->word[i] : 0) - borrow;
        borrow = difference < 0;
        a->word[i] = (uint32_t)(difference + (borrow ? (int64_t)1 << 32 : 0));
    }
    while (a->count && a->word[a->count - 1] == 0)
        a->count--;
    return 1;
}

/* quotient 2^exponent rounded to nearest even, with the quotient's top bit set and `sticky` when a
 * remainder is left below it. */
static double sbi_number_round(uint64_t quotient, int sticky, int exponent)
{
    const uint64_t half = (uint64_t)1 << 63;
    int top = exponent + 63;
    int shift = top < -1022 ? 11 - 1022 - top : 11; /* more bits are lost where doubles are subnormal */
    uint64_t mantissa, rest;
    if (top > 1023)
        return HUGE_VAL;
    if (shift > 64)
        return 0;
    mantissa = shift == 64 ? 0 : quotient >> shift;
    rest = shift == 64 ? quotient : quotient << (64 - shift);
    if (rest > half || (rest == half && (sticky || (mantissa & 1))))
        mantissa++;
    return ldexp((double)mantissa, exponent + shift); /* exact: at most 2^53, and already cut to fit */
}

/* numerator / denominator 2^exponent, rounded; schoolbook division, one bit at a time. */
static double sbi_number_divide_big(sbi_big *numerator, sbi_big *denominator, int exponent, int sticky)
{
    int shift = sbi_big_bits(numerator) - sbi_big_bits(denominator);
    uint64_t quotient = 0;
    sbi_big_shift_left(shift < 0 ? numerator : denominator, shift < 0 ? -shift : shift);
    exponent += shift;
    for (int bits = 0; bits < 64;) {
        int one = sbi_big_take(numerator, denominator);
        quotient = quotient << 1 | (uint64_t)one;
        if (quotient)
            bits++;
        else
            exponent--; /* both have the same length, so this happens at most once */
        sbi_big_shift_left(numerator, 1);
    }
    return sbi_number_round(quotient, sticky || numerator->count > 0, exponent - 63);
}

/* The same for 64-bit numbers. */
static double sbi_number_divide(uint64_t numerator, uint64_t denominator, int exponent)
{
    uint64_t quotient = 0;
    int carry = 0;
    for (; !(numerator >> 63); numerator <<= 1)
        exponent--;
    for (; !(denominator >> 63); denominator <<= 1)
        exponent++;
    for (int bits = 0; bits < 64;) {
        int one = carry || numerator >= denominator;
        if (one)
            numerator -= denominator;
        quotient = quotient << 1 | (uint64_t)one;
        if (quotient)
            bits++;
        else
            exponent--;
        carry = (int)(numerator >> 63);
        numerator <<= 1;
    }
    return sbi_number_round(quotient, carry || numerator, exponent - 63);
}

/* A number cut into its parts: value = digits as an integer * 10^exponent. */
typedef struct sbi_decimal {
    int negative;
    const char *digits; /* first significant digit */
    const char *end;    /* behind the last digit; a point may lie between */
    int64_t count;      /* significant digits */
    int64_t exponent;
    uint64_t leading; /* the first 19 significant digits or fewer */
} sbi_decimal;

/* Correctly rounded whatever the number of digits. A double and the middle of two have 767 digits at most,
 * so of those behind 770 only matters whether they are all zero. */
static double sbi_number_from_digits(const sbi_decimal *decimal)
{
    const int kept_max = 770;
    sbi_big numerator, denominator;
    int kept = 0, sticky = 0, exponent;
    numerator.count = denominator.count = 0;
    for (const char *p = decimal->digits; p < decimal->end; p++) {
        if (*p == '.')
            continue;
        if (kept < kept_max) {
            sbi_big_multiply(&numerator, 10, (uint32_t)(*p - '0'));
            kept++;
        } else if (*p != '0') {
            sticky = 1;
        }
    }
    if (decimal->count + decimal->exponent > 310)
        return HUGE_VAL;
    if (decimal->count + decimal->exponent < -330)
        return 0;
    exponent = (int)(decimal->exponent + decimal->count - kept);
    denominator.word[denominator.count++] = 1;
    sbi_big_multiply_pow5(exponent < 0 ? &denominator : &numerator, exponent < 0 ? -exponent : exponent);
    return sbi_number_divide_big(&numerator, &denominator, exponent, sticky);
}

/* Of a number that is not 0; by the fastest way that is exact. */
static double sbi_number_value(const sbi_decimal *decimal)
{
    const uint64_t exact = (uint64_t)1 << 53;
#if defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD == 0
    /* Both are exact doubles, so that one operation rounds once (not so where doubles are kept in wider
     * registers). */
    static const double pow10[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                                   1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};
    if (decimal->count <= 19 && decimal->leading <= exact) {
        if (decimal->exponent >= 0 && decimal->exponent <= 22)
            return (double)decimal->leading * pow10[decimal->exponent];
        if (decimal->exponent < 0 && decimal->exponent >= -22)
            return (double)decimal->leading / pow10[-decimal->exponent];
    }
#endif
    if (decimal->count <= 19 && decimal->exponent <= 0 && decimal->exponent >= -27) {
        uint64_t pow5 = 1; /* 5^27 < 2^63 */
        for (int i = 0; i < -decimal->exponent; i++)
            pow5 *= 5;
        return sbi_number_divide(decimal->leading, pow5, (int)decimal->exponent);
    }
    (void)exact;
    return sbi_number_from_digits(decimal);
}

/* Digits with at most one point; 0 when there is no digit or a second point. */
static int sbi_decimal_digits(sbi_decimal *decimal, const char *text, const char *end)
{
    int point = 0, any = 0;
    decimal->digits = NULL;
    decimal->count = decimal->exponent = 0;
    decimal->leading = 0;
    for (; text < end && ((*text >= '0' && *text <= '9') || (*text == '.' && !point)); text++) {
        if (*text == '.') {
            point = 1;
            continue;
        }
        any = 1;
        decimal->exponent -= point;
        if (!decimal->digits && *text == '0')
            continue;
        if (!decimal->digits)
            decimal->digits = text;
        if (decimal->count++ < 19)
            decimal->leading = decimal->leading * 10 + (uint64_t)(*text - '0');
    }
    decimal->end = text;
    if (!decimal->digits)
        decimal->digits = text;
    return any;
}

static int sbi_word_is_not_finite(const char *text, size_t length)
{
    /* The Microsoft spellings are 1.#INF, 1.#QNAN, -1.#IND. */
    static const char names[6][9] = {"nan", "inf", "infinity", "1.#inf", "1.#qnan", "1.#ind"};
    sbi_word word;
    if (length && (text[0] == '-' || text[0] == '+'))
        text++, length--;
    word.text = text;
    word.length = length;
    for (int i = 0; i < 6; i++)
        if (sbi_word_is(word, names[i]))
            return 1;
    word.length = length < 4 ? length : 4;
    return sbi_word_is(word, "nan("); /* nan(ind) */
}

SBI_API int sbi_parse_real(const char *text, size_t length, double *value)
{
    const char *end = text + length;
    sbi_decimal decimal;
    double magnitude;
    const char *start = length && (*text == '-' || *text == '+') ? text + 1 : text;
    decimal.negative = start > text && *text == '-';
    if (!sbi_decimal_digits(&decimal, start, end))
        return sbi_word_is_not_finite(text, length) ? -1 : 0;
    if (decimal.end < end) {
        const char *p = decimal.end;
        int64_t exponent = 0;
        int parsed = *p == 'e' || *p == 'E' ? sbi_parse_integer(p + 1, (size_t)(end - p - 1), &exponent) : 0;
        if (!parsed)
            return sbi_word_is_not_finite(text, length) ? -1 : 0;
        /* An exponent beyond 10^18 wins over any number of digits that fits into memory. */
        if (parsed < 0 || exponent > INT64_MAX / 8 || exponent < -(INT64_MAX / 8))
            exponent = p[1] == '-' ? -(INT64_MAX / 8) : INT64_MAX / 8;
        decimal.exponent += exponent;
    }
    magnitude = decimal.leading ? sbi_number_value(&decimal) : 0;
    if (magnitude > DBL_MAX)
        return -1;
    *value = decimal.negative ? -magnitude : magnitude;
    return 1;
}

/* ==== reader ======================================================================================= */

SBI_API void sbi_reader_init(sbi_reader *reader, const void *data, size_t size, const char *name,
                             sb_error *error)
{
    memset(reader, 0, sizeof *reader);
    reader->data = (const char *)data;
    reader->size = size;
    reader->line = 1;
    reader->node = reader->element = -1;
    reader->name = name ? name : "";
    reader->error = error;
}

SBI_API void sbi_error_set_file(sb_error *error, const char *name)
{
    size_t length = strlen(name), room = sizeof error->file - 1;
    if (length > room)
        name += length - room;
    memcpy(error->file, name, length > room ? room + 1 : length + 1);
}

SBI_API sb_result sbi_reader_fail(const sbi_reader *reader, sb_result result, const char *format, ...)
{
    char message[200];
    va_list arguments;
    if (!reader->error)
        return result;
    va_start(arguments, format);
    vsnprintf(message, sizeof message, format, arguments);
    va_end(arguments);
    if (reader->binary)
        sbi_fail(reader->error, result, "%s (at byte %llu)", message, (unsigned long long)reader->at);
    else
        sbi_fail(reader->error, result, "%s", message);
    reader->error->line = reader->binary ? 0 : reader->line;
    reader->error->node = reader->node;
    reader->error->element = reader->element;
    sbi_error_set_file(reader->error, reader->name);
    return result;
}

static int sbi_reader_is_blank(char c) { return c == ' ' || c == '\t' || c == '\v' || c == '\f'; }

/* Length of the line end at `at`: LF, CR LF or a lone CR; 0: none. */
static size_t sbi_reader_newline(const sbi_reader *reader, size_t at)
{
    if (at >= reader->size)
        return 0;
    if (reader->data[at] == '\n')
        return 1;
    if (reader->data[at] != '\r')
        return 0;
    return at + 1 < reader->size && reader->data[at + 1] == '\n' ? 2 : 1;
}

static void sbi_reader_count_line(sbi_reader *reader)
{
    if (reader->line < INT_MAX)
        reader->line++;
}

static void sbi_reader_skip_text(sbi_reader *reader)
{
    while (reader->at < reader->size && !sbi_reader_newline(reader, reader->at))
        reader->at++;
}

SBI_API int sbi_reader_at_line_end(sbi_reader *reader)
{
    while (reader->at < reader->size) {
        char c = reader->data[reader->at];
        if (sbi_reader_is_blank(c)) {
            reader->at++;
        } else if (c == '\\' && reader->continuation && sbi_reader_newline(reader, reader->at + 1)) {
            reader->at += 1 + sbi_reader_newline(reader, reader->at + 1);
            sbi_reader_count_line(reader);
        } else {
            break;
        }
    }
    if (reader->comment && reader->at < reader->size && reader->data[reader->at] == reader->comment)
        sbi_reader_skip_text(reader);
    return reader->at >= reader->size || sbi_reader_newline(reader, reader->at);
}

SBI_API void sbi_reader_next_line(sbi_reader *reader)
{
    sbi_reader_skip_text(reader);
    if (reader->at < reader->size) {
        reader->at += sbi_reader_newline(reader, reader->at);
        sbi_reader_count_line(reader);
    }
}

SBI_API int sbi_reader_line_word(sbi_reader *reader, sbi_word *word)
{
    size_t start;
    if (sbi_reader_at_line_end(reader))
        return 0;
    start = reader->at;
    while (reader->at < reader->size) {
        char c = reader->data[reader->at];
        if (sbi_reader_is_blank(c) || c == '\n' || c == '\r' || (reader->comment && c == reader->comment))
            break;
        if (c == '\\' && reader->continuation && sbi_reader_newline(reader, reader->at + 1))
            break;
        reader->at++;
    }
    word->text = reader->data + start;
    word->length = reader->at - start;
    return 1;
}

SBI_API int sbi_reader_word(sbi_reader *reader, sbi_word *word)
{
    while (!sbi_reader_line_word(reader, word)) {
        if (reader->at >= reader->size)
            return 0;
        sbi_reader_next_line(reader);
    }
    return 1;
}

SBI_API int sbi_reader_peek(const sbi_reader *reader, sbi_word *word)
{
    sbi_reader copy = *reader;
    return sbi_reader_word(&copy, word);
}

static char sbi_reader_lower(char c) { return c >= 'A' && c <= 'Z' ? (char)(c - 'A' + 'a') : c; }

SBI_API int sbi_word_is(sbi_word word, const char *text)
{
    size_t i;
    for (i = 0; i < word.length && text[i]; i++)
        if (sbi_reader_lower(word.text[i]) != sbi_reader_lower(text[i]))
            return 0;
    return i == word.length && !text[i];
}

SBI_API const char *sbi_word_print(sbi_word word, char buffer[32])
{
    size_t length = word.length < 31 ? word.length : 31;
    for (size_t i = 0; i < length; i++)
        buffer[i] = word.text[i] >= ' ' && word.text[i] <= '~' ? word.text[i] : '?';
    buffer[length] = 0;
    return buffer;
}

static sb_result sbi_reader_fail_word(const sbi_reader *reader, const char *what, sbi_word word,
                                      const char *why)
{
    char text[32];
    return sbi_reader_fail(reader, SB_ERROR_FORMAT, "%s: '%s' %s", what, sbi_word_print(word, text), why);
}

SBI_API sb_result sbi_reader_integer(sbi_reader *reader, const char *what, int64_t *value)
{
    sbi_word word;
    int parsed;
    if (!sbi_reader_word(reader, &word))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends where %s should be", what);
    parsed = sbi_parse_integer(word.text, word.length, value);
    if (parsed > 0)
        return SB_OK;
    return sbi_reader_fail_word(reader, what, word, parsed ? "is too large" : "is not an integer");
}

SBI_API sb_result sbi_reader_real(sbi_reader *reader, const char *what, double *value)
{
    sbi_word word;
    char text[32];
    int parsed;
    if (!sbi_reader_word(reader, &word))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends where %s should be", what);
    parsed = sbi_parse_real(word.text, word.length, value);
    if (parsed > 0)
        return SB_OK;
    if (parsed == 0)
        return sbi_reader_fail_word(reader, what, word, "is not a number");
    return sbi_reader_fail(reader, SB_ERROR_NOT_FINITE, "%s: '%s' is not finite", what,
                           sbi_word_print(word, text));
}

SBI_API sb_result sbi_reader_check_count(const sbi_reader *reader, const char *what, int64_t value,
                                         size_t bytes, int *count)
{
    if (value < 0)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "%s is negative: %lld", what, (long long)value);
    if (value > INT_MAX)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "%s is larger than 2147483647: %lld", what,
                               (long long)value);
    /* + 1: in a text the last blank may be missing */
    if (bytes && (uint64_t)value > ((uint64_t)sbi_reader_left(reader) + 1) / bytes)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "%s is %lld, but the file is too short for that",
                               what, (long long)value);
    *count = (int)value;
    return SB_OK;
}

SBI_API sb_result sbi_reader_count(sbi_reader *reader, const char *what, size_t bytes, int *count)
{
    int64_t value = 0;
    sb_result result = sbi_reader_integer(reader, what, &value);
    return result ? result : sbi_reader_check_count(reader, what, value, bytes, count);
}

SBI_API sb_result sbi_reader_skip_words(sbi_reader *reader, size_t count, const char *what)
{
    sbi_word word;
    for (size_t i = 0; i < count; i++)
        if (!sbi_reader_word(reader, &word))
            return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends in %s", what);
    return SB_OK;
}

SBI_API const unsigned char *sbi_reader_bytes(sbi_reader *reader, size_t count, size_t size, const char *what)
{
    const char *bytes = reader->data + reader->at;
    if (size && count > sbi_reader_left(reader) / size) {
        sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends in %s", what);
        return NULL;
    }
    reader->at += count * size;
    return (const unsigned char *)bytes;
}

SBI_API uint64_t sbi_decode_bits(const sbi_reader *reader, const unsigned char *bytes, int size)
{
    uint64_t bits = 0;
    for (int i = 0; i < size; i++)
        bits = bits << 8 | bytes[reader->big_endian ? i : size - 1 - i];
    return bits;
}

SBI_API int64_t sbi_decode_signed(const sbi_reader *reader, const unsigned char *bytes, int size)
{
    uint64_t bits = sbi_decode_bits(reader, bytes, size);
    uint64_t sign = (uint64_t)1 << (8 * size - 1);
    if (!(bits & sign))
        return (int64_t)bits;
    /* the magnitude of a negative number, less one so that it fits */
    return -(int64_t)((sign - 1) - (bits & (sign - 1))) - 1;
}

SBI_API double sbi_decode_float(const sbi_reader *reader, const unsigned char *bytes, int size)
{
    uint64_t bits = sbi_decode_bits(reader, bytes, size);
    uint32_t low = (uint32_t)bits;
    float single;
    double value;
    if (size == 4) {
        memcpy(&single, &low, sizeof single);
        return (double)single;
    }
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* Merges [first, middle) and [middle, end) of `from` into `to`. */
static void sbi_merge_runs(const int *from, int *to, int first, int middle, int end, sbi_before before,
                           const void *context)
{
    int left = first, right = middle;
    for (int i = first; i < end; i++) {
        int take_right = left >= middle || (right < end && before(context, from[right], from[left]));
        to[i] = take_right ? from[right++] : from[left++];
    }
}

SBI_API void sbi_merge_sort(int *order, int *scratch, int count, sbi_before before, const void *context)
{
    int *from = order, *to = scratch;
    for (int64_t width = 1; width < count; width *= 2) {
        int *swap = from;
        for (int64_t first = 0; first < count; first += 2 * width) {
            int64_t middle = first + width < count ? first + width : count;
            int64_t end = middle + width < count ? middle + width : count;
            sbi_merge_runs(from, to, (int)first, (int)middle, (int)end, before, context);
        }
        from = to;
        to = swap;
    }
    if (from != order)
        memcpy(order, from, (size_t)count * sizeof order[0]);
}

/* ==== cells ======================================================================================== */

SBI_API const sbi_cell_kind *sbi_cell_kind_at(int kind)
{
    static const sbi_cell_kind kinds[SBI_CELL_KINDS] = {
        {"tri3", SB_TRI3, 2, 3, 5, 2, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"quad4", SB_QUAD4, 2, 4, 9, 3, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"tet4", SB_TET4, 3, 4, 10, 4, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"tet10", SB_TET10, 3, 10, 24, 11, SBI_ORDER_SAME, SBI_ORDER_GMSH_TET10},
        {"hex8", SB_HEX8, 3, 8, 12, 5, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"tri6", SB_TRI6, 2, 6, 22, 9, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"pixel", SB_QUAD4, 2, 4, 8, -1, SBI_ORDER_PIXEL, SBI_ORDER_SAME},
        {"voxel", SB_HEX8, 3, 8, 11, -1, SBI_ORDER_VOXEL, SBI_ORDER_SAME},
        {"empty cell", SB_NO_ELEMENT, 0, 0, 0, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"vertex", SB_NO_ELEMENT, 0, 1, 1, 15, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"polyvertex", SB_NO_ELEMENT, 0, 0, 2, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"line2", SB_NO_ELEMENT, 1, 2, 3, 1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"polyline", SB_NO_ELEMENT, 1, 0, 4, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"line3", SB_NO_ELEMENT, 1, 3, 21, 8, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"line4", SB_NO_ELEMENT, 1, 4, 35, 26, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"line5", SB_NO_ELEMENT, 1, 5, -1, 27, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"line6", SB_NO_ELEMENT, 1, 6, -1, 28, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"Lagrange curve", SB_NO_ELEMENT, 1, 0, 68, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"triangle strip", SB_NO_ELEMENT, 2, 0, 6, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"polygon", SB_NO_ELEMENT, 2, 0, 7, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"tri7", SB_NO_ELEMENT, 2, 7, 34, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"tri9", SB_NO_ELEMENT, 2, 9, -1, 20, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"tri10", SB_NO_ELEMENT, 2, 10, -1, 21, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"tri12", SB_NO_ELEMENT, 2, 12, -1, 22, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"tri15", SB_NO_ELEMENT, 2, 15, -1, 23, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"tri15 (order 5)", SB_NO_ELEMENT, 2, 15, -1, 24, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"tri21", SB_NO_ELEMENT, 2, 21, -1, 25, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"quad6", SB_NO_ELEMENT, 2, 6, 30, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"quad8", SB_NO_ELEMENT, 2, 8, 23, 16, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"quad9", SB_NO_ELEMENT, 2, 9, 28, 10, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"quadratic polygon", SB_NO_ELEMENT, 2, 0, 36, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"Lagrange triangle", SB_NO_ELEMENT, 2, 0, 69, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"Lagrange quadrilateral", SB_NO_ELEMENT, 2, 0, 70, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"tet20", SB_NO_ELEMENT, 3, 20, -1, 29, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"tet35", SB_NO_ELEMENT, 3, 35, -1, 30, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"tet56", SB_NO_ELEMENT, 3, 56, -1, 31, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"hex20", SB_NO_ELEMENT, 3, 20, 25, 17, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"hex24", SB_NO_ELEMENT, 3, 24, 33, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"hex27", SB_NO_ELEMENT, 3, 27, 29, 12, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"hex64", SB_NO_ELEMENT, 3, 64, -1, 92, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"hex125", SB_NO_ELEMENT, 3, 125, -1, 93, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"wedge6", SB_NO_ELEMENT, 3, 6, 13, 6, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"wedge12", SB_NO_ELEMENT, 3, 12, 31, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"wedge15", SB_NO_ELEMENT, 3, 15, 26, 18, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"wedge18", SB_NO_ELEMENT, 3, 18, 32, 13, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"pyramid5", SB_NO_ELEMENT, 3, 5, 14, 7, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"pyramid13", SB_NO_ELEMENT, 3, 13, 27, 19, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"pyramid14", SB_NO_ELEMENT, 3, 14, -1, 14, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"pentagonal prism", SB_NO_ELEMENT, 3, 10, 15, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"hexagonal prism", SB_NO_ELEMENT, 3, 12, 16, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"convex point set", SB_NO_ELEMENT, 3, 0, 41, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"polyhedron", SB_NO_ELEMENT, 3, 0, 42, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"Lagrange tetrahedron", SB_NO_ELEMENT, 3, 0, 71, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"Lagrange hexahedron", SB_NO_ELEMENT, 3, 0, 72, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
        {"Lagrange wedge", SB_NO_ELEMENT, 3, 0, 73, -1, SBI_ORDER_SAME, SBI_ORDER_SAME},
    };
    return &kinds[kind];
}

SBI_API int sbi_cell_kind_of_vtk(int64_t number)
{
    for (int kind = 0; number >= 0 && kind < SBI_CELL_KINDS; kind++)
        if (sbi_cell_kind_at(kind)->vtk == number)
            return kind;
    return -1;
}

SBI_API int sbi_cell_kind_of_gmsh(int64_t number)
{
    for (int kind = 0; number >= 0 && kind < SBI_CELL_KINDS; kind++)
        if (sbi_cell_kind_at(kind)->gmsh == number)
            return kind;
    return -1;
}

/* Position in the file's list of our node i. */
static int sbi_node_order_at(sbi_node_order order, int i)
{
    static const unsigned char voxel[8] = {0, 1, 3, 2, 4, 5, 7, 6}; /* its first four are a pixel's */
    static const unsigned char gmsh_tet10[10] = {0, 1, 2, 3, 4, 5, 6, 7, 9, 8};
    switch (order) {
    case SBI_ORDER_PIXEL:
    case SBI_ORDER_VOXEL: return voxel[i];
    case SBI_ORDER_GMSH_TET10: return gmsh_tet10[i];
    case SBI_ORDER_SAME: break;
    }
    return i;
}

/* ==== loader ======================================================================================= */

SBI_API void sbi_loader_init(sbi_loader *loader, const sb_load_options *options, sb_error *error)
{
    memset(loader, 0, sizeof *loader);
    sbi_reader_init(&loader->reader, "", 0, "", error);
    loader->allocator = options->allocator;
    loader->scale = (double)options->scale;
}

SBI_API void sbi_loader_free(sbi_loader *loader)
{
    sbi_free(&loader->allocator, loader->nodes);
    sbi_free(&loader->allocator, loader->indices);
    sbi_free(&loader->allocator, loader->cells);
    sbi_free(&loader->allocator, loader->scratch);
    sbi_free(&loader->allocator, loader->source_regions);
}

SBI_API sb_result sbi_loader_no_memory(const sbi_loader *loader)
{
    sbi_fail(loader->reader.error, SB_ERROR_MEMORY, "out of memory while loading a mesh");
    if (loader->reader.error)
        sbi_error_set_file(loader->reader.error, loader->reader.name);
    return SB_ERROR_MEMORY;
}

SBI_API void *sbi_loader_grow(const sbi_loader *loader, void *old, size_t used, size_t *capacity,
                              size_t needed, size_t item)
{
    size_t target = *capacity < ((size_t)-1) / 2 ? 2 * *capacity : needed;
    void *grown;
    if (target < needed)
        target = needed;
    if (target < 16)
        target = 16;
    grown = sbi_alloc(&loader->allocator, target, item);
    if (!grown)
        return NULL;
    if (used)
        memcpy(grown, old, used * item);
    sbi_free(&loader->allocator, old);
    *capacity = target;
    return grown;
}

static int sbi_loader_room_for_nodes(sbi_loader *loader, size_t needed)
{
    void *grown = loader->nodes;
    if (needed > loader->node_capacity)
        grown = sbi_loader_grow(loader, loader->nodes, loader->node_count, &loader->node_capacity, needed,
                                sizeof loader->nodes[0]);
    if (grown)
        loader->nodes = (sb_vec3 *)grown;
    return grown != NULL;
}

SBI_API sb_result sbi_loader_reserve_nodes(sbi_loader *loader, int count)
{
    size_t needed = loader->node_count + (size_t)count;
    return count == 0 || sbi_loader_room_for_nodes(loader, needed) ? SB_OK : sbi_loader_no_memory(loader);
}

SBI_API sb_result sbi_loader_add_node(sbi_loader *loader, const double x[3])
{
    sb_real scaled[3];
    sbi_reader *reader = &loader->reader;
    reader->node = (int)loader->node_count;
    for (int i = 0; i < 3; i++) {
        double value = x[i] * loader->scale;
        if (x[i] - x[i] != 0)
            return sbi_reader_fail(reader, SB_ERROR_NOT_FINITE, "a coordinate of node %d is not finite",
                                   reader->node);
        if (fabs(value) > (double)SB_REAL_MAX)
            return sbi_reader_fail(reader, SB_ERROR_NOT_FINITE, "a coordinate of node %d is too large: %g",
                                   reader->node, value);
        scaled[i] = (sb_real)value;
    }
    if (loader->node_count >= INT_MAX)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 nodes");
    if (loader->node_count >= loader->node_capacity &&
        !sbi_loader_room_for_nodes(loader, loader->node_count + 1))
        return sbi_loader_no_memory(loader);
    loader->nodes[loader->node_count++] = sb_v3(scaled[0], scaled[1], scaled[2]);
    reader->node = -1;
    return SB_OK;
}

SBI_API sb_result sbi_loader_read_node(sbi_loader *loader)
{
    double x[3] = {0, 0, 0};
    loader->reader.node = (int)loader->node_count;
    for (int i = 0; i < 3; i++) {
        sb_result result = sbi_reader_real(&loader->reader, "coordinate", &x[i]);
        if (result)
            return result;
    }
    return sbi_loader_add_node(loader, x);
}

SBI_API void sbi_loader_begin_cell(sbi_loader *loader)
{
    loader->scratch_count = 0;
    loader->reader.element = loader->source_count;
}

SBI_API sb_result sbi_loader_cell_node(sbi_loader *loader, int64_t number, int64_t base)
{
    int64_t last = base + (int64_t)loader->node_count - 1;
    if (loader->node_count == 0)
        return sbi_reader_fail(&loader->reader, SB_ERROR_INDEX, "a cell before the first node");
    if (number < base || number > last)
        return sbi_reader_fail(&loader->reader, SB_ERROR_INDEX,
                               "node %lld does not exist: nodes are %lld to %lld", (long long)number,
                               (long long)base, (long long)last);
    if (loader->scratch_count >= loader->scratch_capacity) {
        void *grown =
            sbi_loader_grow(loader, loader->scratch, loader->scratch_count, &loader->scratch_capacity,
                            loader->scratch_count + 1, sizeof loader->scratch[0]);
        if (!grown)
            return sbi_loader_no_memory(loader);
        loader->scratch = (int *)grown;
    }
    loader->scratch[loader->scratch_count++] = (int)(number - base);
    return SB_OK;
}

/* Room for one more cell of `nodes` nodes. */
static sb_result sbi_loader_reserve_cell(sbi_loader *loader, size_t nodes)
{
    void *grown;
    if (loader->cell_count >= INT_MAX)
        return sbi_reader_fail(&loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 elements");
    if (loader->cell_count >= loader->cell_capacity) {
        grown = sbi_loader_grow(loader, loader->cells, loader->cell_count, &loader->cell_capacity,
                                loader->cell_count + 1, sizeof loader->cells[0]);
        if (!grown)
            return sbi_loader_no_memory(loader);
        loader->cells = (sbi_cell *)grown;
    }
    if (nodes > loader->index_capacity - loader->index_count) {
        grown = sbi_loader_grow(loader, loader->indices, loader->index_count, &loader->index_capacity,
                                loader->index_count + nodes, sizeof loader->indices[0]);
        if (!grown)
            return sbi_loader_no_memory(loader);
        loader->indices = (int *)grown;
    }
    return SB_OK;
}

/* Appends a cell with the nodes scratch[a], scratch[b], ... or, with corners NULL, all of them in `order`. */
static sb_result sbi_loader_push_cell(sbi_loader *loader, int kind, const size_t corners[3],
                                      sbi_node_order order, int region)
{
    int nodes = sbi_cell_kind_at(kind)->nodes;
    sb_result result = sbi_loader_reserve_cell(loader, (size_t)nodes);
    sbi_cell *cell;
    if (result)
        return result;
    cell = &loader->cells[loader->cell_count++];
    cell->kind = kind;
    cell->source = loader->source_count;
    cell->region = region;
    for (int i = 0; i < nodes; i++) {
        size_t from = corners ? corners[i] : (size_t)sbi_node_order_at(order, i);
        loader->indices[loader->index_count++] = loader->scratch[from];
    }
    return SB_OK;
}

/* Counts a finished cell of the file. */
static sb_result sbi_loader_count_cell(sbi_loader *loader, int kind)
{
    if (loader->source_count == INT_MAX)
        return sbi_reader_fail(&loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 cells");
    if (loader->kind_count[kind]++ == 0) {
        loader->kind_line[kind] = loader->reader.binary ? 0 : loader->reader.line;
        loader->kind_first[kind] = loader->source_count;
    }
    loader->source_count++;
    loader->reader.element = -1;
    return SB_OK;
}

SBI_API sb_result sbi_loader_end_cell(sbi_loader *loader, int kind, sbi_node_order order, int region)
{
    const sbi_cell_kind *about = sbi_cell_kind_at(kind);
    sb_result result = SB_OK;
    if (about->nodes && loader->scratch_count != (size_t)about->nodes)
        return sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "cell %d has %llu nodes, but a %s has %d",
                               loader->source_count, (unsigned long long)loader->scratch_count, about->name,
                               about->nodes);
    if (about->type != SB_NO_ELEMENT)
        result = sbi_loader_push_cell(loader, kind, NULL, order, region);
    return result ? result : sbi_loader_count_cell(loader, kind);
}

static sb_result sbi_loader_end_triangles(sbi_loader *loader, int region, int strip)
{
    sb_result result = SB_OK;
    size_t count = loader->scratch_count;
    if (count < 3)
        return sbi_reader_fail(&loader->reader, SB_ERROR_FORMAT, "face %d has %llu corners",
                               loader->source_count, (unsigned long long)count);
    for (size_t i = 0; i + 2 < count && !result; i++) {
        size_t fan[3], odd = strip ? i % 2 : 0;
        fan[0] = strip ? i : 0;
        fan[1] = i + 1 + odd; /* every other triangle of a strip turns round */
        fan[2] = i + 2 - odd;
        result = sbi_loader_push_cell(loader, SBI_CELL_TRI3, fan, SBI_ORDER_SAME, region);
    }
    if (!result && count > 3)
        loader->split_polygons++;
    return result ? result : sbi_loader_count_cell(loader, SBI_CELL_TRI3);
}

SBI_API sb_result sbi_loader_end_polygon(sbi_loader *loader, int region)
{
    return sbi_loader_end_triangles(loader, region, 0);
}

SBI_API sb_result sbi_loader_end_strip(sbi_loader *loader, int region)
{
    return sbi_loader_end_triangles(loader, region, 1);
}

/* ---- from cells to one element type ---- */

static sb_result sbi_loader_fail_kind(const sbi_loader *loader, int kind, const char *format,
                                      const char *first, const char *second)
{
    sbi_reader place = loader->reader;
    char message[160];
    place.line = loader->kind_line[kind];
    place.binary = 0;
    place.element = loader->kind_first[kind];
    snprintf(message, sizeof message, "%s%s%s", first, format, second);
    return sbi_reader_fail(&place, SB_ERROR_UNSUPPORTED, "%s", message);
}

/* The highest dimension in the file; counts the cells below it. */
static int sbi_loader_find_dimension(sbi_loader *loader)
{
    int dimension = 0;
    for (int kind = 0; kind < SBI_CELL_KINDS; kind++)
        if (loader->kind_count[kind] && sbi_cell_kind_at(kind)->dimension > dimension)
            dimension = sbi_cell_kind_at(kind)->dimension;
    loader->skipped_cells = 0;
    for (int kind = 0; kind < SBI_CELL_KINDS; kind++)
        if (sbi_cell_kind_at(kind)->dimension < dimension)
            loader->skipped_cells += loader->kind_count[kind];
    return dimension;
}

static int sbi_loader_is_flat_pair(sb_element_type a, sb_element_type b)
{
    return (a == SB_TRI3 && b == SB_QUAD4) || (a == SB_QUAD4 && b == SB_TRI3);
}

/* The one element type of the cells of the dimension; tri3 where triangles are mixed with quadrilaterals. */
static sb_result sbi_loader_find_type(const sbi_loader *loader, int dimension, sb_element_type *type)
{
    int first = -1;
    for (int kind = 0; kind < SBI_CELL_KINDS; kind++) {
        const sbi_cell_kind *about = sbi_cell_kind_at(kind);
        if (!loader->kind_count[kind] || about->dimension != dimension)
            continue;
        if (about->type == SB_NO_ELEMENT)
            return sbi_loader_fail_kind(loader, kind, " elements are not supported", about->name, "");
        if (first < 0) {
            first = kind;
            *type = about->type;
        } else if (sbi_loader_is_flat_pair(*type, about->type)) {
            *type = SB_TRI3;
        } else if (*type != about->type) {
            return sbi_loader_fail_kind(loader, kind, " and ", sbi_cell_kind_at(first)->name, about->name);
        }
    }
    return SB_OK;
}

/* Number of elements the cells make. */
static int64_t sbi_loader_count_elements(const sbi_loader *loader, int dimension, sb_element_type type)
{
    int64_t count = 0;
    for (size_t i = 0; i < loader->cell_count; i++) {
        const sbi_cell_kind *about = sbi_cell_kind_at(loader->cells[i].kind);
        if (about->dimension == dimension)
            count += about->type == type ? 1 : 2;
    }
    return count;
}

/* Copies the cells of the dimension; a quadrilateral among triangles becomes 0 1 2 and 0 2 3. */
static void sbi_loader_copy_cells(sbi_loader *loader, int dimension, sb_mesh *mesh, int *regions)
{
    int nodes = sb_element_node_count(mesh->element_type), element = 0;
    const int *from = loader->indices;
    for (size_t i = 0; i < loader->cell_count; i++) {
        const sbi_cell *cell = &loader->cells[i];
        const sbi_cell_kind *about = sbi_cell_kind_at(cell->kind);
        int parts = about->type == mesh->element_type ? 1 : 2;
        for (int part = 0; part < parts && about->dimension == dimension; part++) {
            int *to = mesh->elements + (size_t)element * (size_t)nodes;
            for (int a = 0; a < nodes; a++)
                to[a] = from[a == 0 ? 0 : a + part];
            regions[element++] = loader->source_regions ? loader->source_regions[cell->source] : cell->region;
        }
        if (parts == 2 && about->dimension == dimension)
            loader->split_polygons++;
        from += about->nodes;
    }
}

static int sbi_loader_any_region(const int *regions, int count)
{
    for (int i = 0; i < count; i++)
        if (regions[i])
            return 1;
    return 0;
}

SBI_API sb_result sbi_loader_build(sbi_loader *loader, sb_mesh *mesh)
{
    int dimension = sbi_loader_find_dimension(loader), nodes;
    sb_element_type type = SB_NO_ELEMENT;
    int64_t count;
    sb_result result;
    loader->reader.element = loader->reader.node = -1;
    if (dimension < 2)
        return sbi_reader_fail(&loader->reader, SB_ERROR_MESH,
                               "the file has no faces and no volume elements");
    result = sbi_loader_find_type(loader, dimension, &type);
    if (result)
        return result;
    count = sbi_loader_count_elements(loader, dimension, type);
    if (count > INT_MAX)
        return sbi_reader_fail(&loader->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 elements");
    nodes = sb_element_node_count(type);
    mesh->allocator = loader->allocator;
    mesh->element_type = type;
    mesh->element_count = (int)count;
    mesh->elements = (int *)sbi_alloc(&loader->allocator, (size_t)count, (size_t)nodes * sizeof(int));
    mesh->regions = (int *)sbi_alloc(&loader->allocator, (size_t)count, sizeof(int));
    if (!mesh->elements || !mesh->regions)
        return sbi_loader_no_memory(loader);
    sbi_loader_copy_cells(loader, dimension, mesh, mesh->regions);
    if (!sbi_loader_any_region(mesh->regions, mesh->element_count)) {
        sbi_free(&loader->allocator, mesh->regions);
        mesh->regions = NULL;
    }
    mesh->node_count = (int)loader->node_count;
    mesh->nodes = loader->nodes;
    loader->nodes = NULL;
    loader->node_count = loader->node_capacity = 0;
    return SB_OK;
}

/* ==== src/softbody/meshio.c ==== */
/* meshio: loading (file, format, checks, report) and the writers. */

#include <float.h>
#include <limits.h>
#include <stdio.h>
#include <string.h>


/* ==== options ====================================================================================== */

enum { SBI_LOAD_COOKIE = 0x6d657368 };

SB_API sb_load_options sb_default_load_options(void)
{
    sb_load_options options;
    memset(&options, 0, sizeof options);
    options.scale = 1;
    options.cookie = SBI_LOAD_COOKIE;
    return options;
}

/* Copies the options or their defaults; refuses those out of range. */
static sb_result sbi_meshio_resolve(const sb_load_options *options, sb_load_options *resolved,
                                    sb_error *error)
{
    *resolved = options ? *options : sb_default_load_options();
    if (resolved->cookie != SBI_LOAD_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "the load options do not come from sb_default_load_options()");
    if (!(resolved->scale > 0) || !sb_is_finite(resolved->scale))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the scale is %g, it must be positive",
                        (double)resolved->scale);
    return SB_OK;
}

/* ==== files ======================================================================================== */

/* The content of a file. */
typedef struct sbi_file {
    char *data;
    size_t size;
} sbi_file;

static sb_result sbi_meshio_fail_file(sb_error *error, sb_result result, const char *path, const char *why)
{
    sbi_fail(error, result, "%s", why);
    if (error)
        sbi_error_set_file(error, path);
    return result;
}

/* Twice the room; the content moves along. */
static int sbi_meshio_grow_file(const sb_allocator *allocator, sbi_file *content, size_t *capacity)
{
    char *grown;
    if (*capacity > ((size_t)-1) / 2)
        return 0;
    grown = (char *)sbi_alloc(allocator, 2 * *capacity, 1);
    if (!grown)
        return 0;
    memcpy(grown, content->data, content->size);
    sbi_free(allocator, content->data);
    content->data = grown;
    *capacity *= 2;
    return 1;
}

/* Reads until the end rather than asking for the size, which pipes do not have and folders make up. */
static sb_result sbi_meshio_read_file(const sb_allocator *allocator, const char *path, sbi_file *content,
                                      sb_error *error)
{
    size_t capacity = 1 << 16, got = 1;
    sb_result result = SB_OK;
    FILE *file = fopen(path, "rb");
    content->size = 0;
    content->data = NULL;
    if (!file)
        return sbi_meshio_fail_file(error, SB_ERROR_FILE, path, "the file cannot be opened");
    content->data = (char *)sbi_alloc(allocator, capacity, 1);
    if (!content->data)
        result = sbi_meshio_fail_file(error, SB_ERROR_MEMORY, path, "out of memory while reading a file");
    while (!result && got) {
        if (content->size == capacity && !sbi_meshio_grow_file(allocator, content, &capacity)) {
            result = sbi_meshio_fail_file(error, SB_ERROR_MEMORY, path, "out of memory while reading a file");
            break;
        }
        got = fread(content->data + content->size, 1, capacity - content->size, file);
        content->size += got;
    }
    if (!result && ferror(file))
        result = sbi_meshio_fail_file(error, SB_ERROR_FILE, path, "the file cannot be read");
    fclose(file);
    return result;
}

/* ==== format ======================================================================================= */

static int sbi_meshio_starts_with(const sbi_reader *reader, const char *text)
{
    sbi_word word;
    word.text = reader->data + reader->at;
    word.length = strlen(text);
    return sbi_reader_left(reader) >= word.length && sbi_word_is(word, text);
}

static int sbi_meshio_name_ends_with(const char *name, const char *ending)
{
    size_t length = strlen(name), tail = strlen(ending);
    sbi_word word;
    if (length < tail)
        return 0;
    word.text = name + length - tail;
    word.length = tail;
    return sbi_word_is(word, ending);
}

static sb_file_format sbi_meshio_format_of_name(const char *name)
{
    static const struct {
        char ending[6];
        sb_file_format format;
    } endings[] = {{".vtk", SB_FILE_VTK},    {".msh", SB_FILE_GMSH}, {".node", SB_FILE_TETGEN},
                   {".ele", SB_FILE_TETGEN}, {".obj", SB_FILE_OBJ},  {".stl", SB_FILE_STL},
                   {".ply", SB_FILE_PLY},    {".off", SB_FILE_OFF}};
    for (size_t i = 0; i < sizeof endings / sizeof endings[0]; i++)
        if (sbi_meshio_name_ends_with(name, endings[i].ending))
            return endings[i].format;
    return SB_FILE_AUTO;
}

/* By what the file begins with; AUTO when that tells nothing. */
static sb_file_format sbi_meshio_format_of_content(const sbi_reader *reader)
{
    sbi_word word;
    /* First, since the header of a binary STL file may hold anything. A text whose bytes happen to be such
     * a count would have to be as large as that count says: more than 7 GB. */
    if (sbi_stl_is_binary(reader->data, reader->size))
        return SB_FILE_STL;
    if (sbi_meshio_starts_with(reader, "# vtk DataFile"))
        return SB_FILE_VTK;
    if (!sbi_reader_peek(reader, &word))
        return SB_FILE_AUTO;
    if (word.length > 1 && word.text[0] == '$' && word.text[1] >= 'A' && word.text[1] <= 'Z')
        return SB_FILE_GMSH;
    if (sbi_word_is(word, "ply"))
        return SB_FILE_PLY;
    if (sbi_word_is(word, "solid"))
        return SB_FILE_STL;
    if (word.length >= 3 && word.length <= 8 && memcmp(word.text + word.length - 3, "OFF", 3) == 0)
        return SB_FILE_OFF;
    return SB_FILE_AUTO;
}

/* OBJ has no mark of its own: a file without a telling name whose first line is one of OBJ's. */
static int sbi_meshio_looks_like_obj(const sbi_reader *reader)
{
    static const char keywords[9][7] = {"v", "vn", "vt", "f", "o", "g", "s", "mtllib", "usemtl"};
    sbi_reader ahead = *reader;
    sbi_word word;
    ahead.comment = '#';
    if (!sbi_reader_word(&ahead, &word))
        return 0;
    for (int i = 0; i < 9; i++)
        if (sbi_word_is(word, keywords[i]))
            return 1;
    return 0;
}

static sb_result sbi_meshio_detect(const sbi_reader *reader, sb_file_format *format)
{
    if (reader->size == 0)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file is empty");
    if (*format == SB_FILE_AUTO)
        *format = sbi_meshio_format_of_content(reader);
    if (*format == SB_FILE_AUTO && reader->data[0] == '<')
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "XML files are not read: save as legacy VTK");
    if (*format == SB_FILE_AUTO)
        *format = sbi_meshio_format_of_name(reader->name);
    if (*format == SB_FILE_AUTO && sbi_meshio_looks_like_obj(reader))
        *format = SB_FILE_OBJ;
    if (*format == SB_FILE_AUTO)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file is in no known format");
    return SB_OK;
}

/* ==== loading ====================================================================================== */

static sb_result sbi_meshio_parse(sbi_loader *loader, sb_file_format format)
{
    switch (format) {
    case SB_FILE_VTK: return sbi_vtk_read(loader);
    case SB_FILE_GMSH: return sbi_gmsh_read(loader);
    case SB_FILE_OBJ: return sbi_obj_read(loader);
    case SB_FILE_STL: return sbi_stl_read(loader);
    case SB_FILE_PLY: return sbi_ply_read(loader);
    case SB_FILE_OFF: return sbi_off_read(loader);
    case SB_FILE_TETGEN:
    case SB_FILE_AUTO: break;
    }
    return sbi_reader_fail(&loader->reader, SB_ERROR_ARGUMENT,
                           "this format cannot be read from one piece of memory");
}

/* A volume must be one that can be computed with. Elements that are all inverted are a convention of the
 * file's program and are turned; some of them only when the caller asked for it. */
static sb_result sbi_meshio_accept_volume(sb_mesh *mesh, int fix_orientation, int *flipped, sb_error *error)
{
    sb_error found;
    sb_result result = sb_mesh_validate(mesh, &found), oriented = SB_OK;
    if (result == SB_ERROR_MESH) {
        sb_error failure;
        oriented = sb_mesh_orient(mesh, flipped, &failure);
        if (oriented == SB_ERROR_MEMORY) {
            found = failure;
            result = oriented;
        } else if (!oriented && *flipped > 0 && (*flipped == mesh->element_count || fix_orientation)) {
            result = sb_mesh_validate(mesh, &found);
        }
    }
    if (result && error)
        *error = found;
    return result;
}

static sb_result sbi_meshio_accept(sb_mesh *mesh, int fix_orientation, int *flipped, sb_error *error)
{
    switch (mesh->element_type) {
    case SB_TRI3:
    case SB_TRI6:
    case SB_QUAD4: return fix_orientation ? sb_mesh_orient_surface(mesh, flipped, error) : SB_OK;
    case SB_NO_ELEMENT:
    case SB_TET4:
    case SB_TET10:
    case SB_HEX8: break;
    }
    return sbi_meshio_accept_volume(mesh, fix_orientation, flipped, error);
}

/* Nodes that no element uses; -1 without memory. */
static int sbi_meshio_count_unreferenced(const sb_mesh *mesh)
{
    size_t used = (size_t)mesh->element_count * (size_t)sb_element_node_count(mesh->element_type);
    unsigned char *seen = (unsigned char *)sbi_alloc_zeroed(&mesh->allocator, (size_t)mesh->node_count, 1);
    int count = 0;
    if (!seen)
        return -1;
    for (size_t i = 0; i < used; i++)
        seen[mesh->elements[i]] = 1;
    for (int i = 0; i < mesh->node_count; i++)
        count += !seen[i];
    sbi_free(&mesh->allocator, seen);
    return count;
}

static sb_result sbi_meshio_report(const sbi_loader *loader, const sb_mesh *mesh, sb_file_format format,
                                   int flipped, sb_load_report *report)
{
    int unreferenced = sbi_meshio_count_unreferenced(mesh);
    if (unreferenced < 0)
        return sbi_loader_no_memory(loader);
    report->format = format;
    report->file_cells = loader->source_count;
    report->skipped_cells = loader->skipped_cells;
    report->split_polygons = loader->split_polygons;
    report->merged_vertices = loader->merged_vertices;
    report->flipped_elements = flipped;
    report->unreferenced_nodes = unreferenced;
    return SB_OK;
}

/* From the cells of the file to the caller's mesh and report. */
static sb_result sbi_meshio_finish(sbi_loader *loader, const sb_load_options *options, sb_file_format format,
                                   sb_mesh *mesh)
{
    sb_mesh loaded;
    sb_error *error = loader->reader.error;
    int flipped = 0;
    sb_result result;
    memset(&loaded, 0, sizeof loaded);
    result = sbi_loader_build(loader, &loaded);
    if (!result) {
        result = sbi_meshio_accept(&loaded, options->fix_orientation, &flipped, error);
        if (result && error)
            sbi_error_set_file(error, loader->reader.name);
    }
    if (!result && options->report)
        result = sbi_meshio_report(loader, &loaded, format, flipped, options->report);
    if (result)
        sb_mesh_free(&loaded);
    else
        *mesh = loaded;
    return result;
}

/* Points the loader's reader to a file's content, behind the byte order mark that some programs put before
 * text. */
static void sbi_meshio_set_reader(sbi_loader *loader, const char *data, size_t size, const char *name)
{
    sb_error *error = loader->reader.error;
    if (size >= 3 && memcmp(data, "\xEF\xBB\xBF", 3) == 0 && !sbi_stl_is_binary(data, size)) {
        data += 3;
        size -= 3;
    }
    sbi_reader_init(&loader->reader, data, size, name, error);
}

SB_API sb_result sb_mesh_load_memory(sb_mesh *mesh, const void *data, size_t size, sb_file_format format,
                                     const char *name, const sb_load_options *options, sb_error *error)
{
    sb_load_options resolved;
    sbi_loader loader;
    sb_result result = sbi_meshio_resolve(options, &resolved, error);
    if (result)
        return result;
    if (!mesh || (!data && size))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", mesh ? "data" : "mesh");
    if ((int)format < SB_FILE_AUTO || (int)format > SB_FILE_OFF)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d is not a file format", (int)format);
    sbi_loader_init(&loader, &resolved, error);
    sbi_meshio_set_reader(&loader, size ? (const char *)data : "", size, name);
    result = sbi_meshio_detect(&loader.reader, &format);
    if (!result)
        result = sbi_meshio_parse(&loader, format);
    if (!result)
        result = sbi_meshio_finish(&loader, &resolved, format, mesh);
    sbi_loader_free(&loader);
    return result;
}

/* A copy of the path with its ending, of `cut` characters, replaced; NULL without memory. */
static char *sbi_meshio_change_ending(const sb_allocator *allocator, const char *path, size_t cut,
                                      const char *ending)
{
    size_t stem = strlen(path) - cut, tail = strlen(ending) + 1;
    char *changed = (char *)sbi_alloc(allocator, stem + tail, 1);
    if (changed) {
        memcpy(changed, path, stem);
        memcpy(changed + stem, ending, tail);
    }
    return changed;
}

/* One of TetGen's files: reads it, parses it and lets the content go. */
static sb_result sbi_meshio_read_part(sbi_loader *loader, const char *path, int is_nodes, int64_t *base)
{
    sbi_file content;
    sb_result result = sbi_meshio_read_file(&loader->allocator, path, &content, loader->reader.error);
    if (!result) {
        sbi_meshio_set_reader(loader, content.data, content.size, path);
        result = is_nodes ? sbi_tetgen_read_nodes(loader, base) : sbi_tetgen_read_elements(loader, *base);
    }
    sbi_free(&loader->allocator, content.data);
    return result;
}

static sb_result sbi_meshio_load_tetgen(sbi_loader *loader, const char *path, const sb_load_options *options,
                                        sb_mesh *mesh)
{
    const sb_allocator *allocator = &loader->allocator;
    size_t cut = sbi_meshio_name_ends_with(path, ".node") ? 5 : 4;
    /* the other file's name in the same case, for file systems that tell */
    int capitals = path[strlen(path) - cut + 1] < 'a';
    char *nodes = sbi_meshio_change_ending(allocator, path, cut, capitals ? ".NODE" : ".node");
    char *elements = sbi_meshio_change_ending(allocator, path, cut, capitals ? ".ELE" : ".ele");
    int64_t base = 0;
    sb_result result = nodes && elements ? SB_OK : sbi_loader_no_memory(loader);
    if (!result)
        result = sbi_meshio_read_part(loader, nodes, 1, &base);
    if (!result)
        result = sbi_meshio_read_part(loader, elements, 0, &base);
    if (!result)
        result = sbi_meshio_finish(loader, options, SB_FILE_TETGEN, mesh);
    sbi_free(allocator, nodes);
    sbi_free(allocator, elements);
    return result;
}

SB_API sb_result sb_mesh_load(sb_mesh *mesh, const char *path, const sb_load_options *options,
                              sb_error *error)
{
    sb_load_options resolved;
    sb_file_format format = SB_FILE_AUTO;
    sbi_loader loader;
    sbi_file content;
    sb_result result = sbi_meshio_resolve(options, &resolved, error);
    if (result)
        return result;
    if (!mesh || !path)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", mesh ? "path" : "mesh");
    sbi_loader_init(&loader, &resolved, error);
    result = sbi_meshio_read_file(&loader.allocator, path, &content, error);
    if (!result) {
        sbi_meshio_set_reader(&loader, content.data, content.size, path);
        result = sbi_meshio_detect(&loader.reader, &format);
    }
    if (!result && format == SB_FILE_TETGEN)
        result = sbi_meshio_load_tetgen(&loader, path, &resolved, mesh);
    else if (!result) {
        result = sbi_meshio_parse(&loader, format);
        if (!result)
            result = sbi_meshio_finish(&loader, &resolved, format, mesh);
    }
    sbi_free(&loader.allocator, content.data);
    sbi_loader_free(&loader);
    return result;
}

/* ==== writing ====================================================================================== */

/* A file being written. Errors are remembered and told at the end. */
typedef struct sbi_export {
    FILE *file;
    const char *path;
    int existed, failed, binary;
} sbi_export;

static sb_result sbi_export_open(sbi_export *out, const char *path, int binary, sb_error *error)
{
    FILE *before = fopen(path, "rb");
    out->existed = before != NULL;
    if (before)
        fclose(before);
    out->path = path;
    out->failed = 0;
    out->binary = binary;
    out->file = fopen(path, "wb");
    return out->file
               ? SB_OK
               : sbi_meshio_fail_file(error, SB_ERROR_FILE, path, "the file cannot be opened for writing");
}

/* A file cut short would be mistaken for a mesh. What was there before is not removed, since it may be a
 * device. */
static sb_result sbi_export_close(sbi_export *out, sb_error *error)
{
    if (fclose(out->file) != 0)
        out->failed = 1;
    if (!out->failed)
        return SB_OK;
    if (out->existed) {
        FILE *emptied = fopen(out->path, "wb");
        if (emptied)
            fclose(emptied);
    } else {
        remove(out->path);
    }
    return sbi_meshio_fail_file(error, SB_ERROR_FILE, out->path,
                                "the file cannot be written: is the disk full?");
}

static void sbi_export_bytes(sbi_export *out, const void *bytes, size_t size)
{
    if (!out->failed && fwrite(bytes, 1, size, out->file) != size)
        out->failed = 1;
}

static void sbi_export_text(sbi_export *out, const char *text) { sbi_export_bytes(out, text, strlen(text)); }

/* The low `size` bytes of a number. */
static void sbi_export_bits(sbi_export *out, uint64_t bits, int size, int big_endian)
{
    unsigned char bytes[8];
    for (int i = 0; i < size; i++)
        bytes[big_endian ? size - 1 - i : i] = (unsigned char)(bits >> (8 * i) & 0xFF);
    sbi_export_bytes(out, bytes, (size_t)size);
}

static uint64_t sbi_export_float_bits(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static uint64_t sbi_export_real_bits(sb_real value)
{
#if SB_REAL_IS_FLOAT
    return sbi_export_float_bits(value);
#else
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
#endif
}

/* All digits of a number, with a point whatever the locale's (which may take several bytes). */
static void sbi_export_print_real(sbi_export *out, sb_real value)
{
    char text[48], clean[48];
    size_t length = 0;
    snprintf(text, sizeof text, SB_REAL_IS_FLOAT ? "%.9g" : "%.17g", (double)value);
    for (const char *p = text; *p; p++) {
        int part = (*p >= '0' && *p <= '9') || *p == '-' || *p == '+' || *p == 'e';
        if (part)
            clean[length++] = *p;
        else if (length == 0 || clean[length - 1] != '.')
            clean[length++] = '.';
    }
    sbi_export_bytes(out, clean, length);
}

/* `count` numbers as one row; in a binary file big-endian, as VTK has them. */
static void sbi_export_reals(sbi_export *out, const sb_real *values, int count)
{
    for (int i = 0; i < count; i++) {
        if (out->binary) {
            sbi_export_bits(out, sbi_export_real_bits(values[i]), (int)sizeof(sb_real), 1);
            continue;
        }
        sbi_export_print_real(out, values[i]);
        sbi_export_text(out, i + 1 < count ? " " : "\n");
    }
}

static void sbi_export_integer(sbi_export *out, int value, const char *after)
{
    char text[16];
    if (out->binary) {
        sbi_export_bits(out, (uint64_t)(int64_t)value, 4, 1);
        return;
    }
    snprintf(text, sizeof text, "%d", value);
    sbi_export_text(out, text);
    sbi_export_text(out, after);
}

static void sbi_export_node(sbi_export *out, sb_vec3 node)
{
    sb_real x[3];
    x[0] = node.x;
    x[1] = node.y;
    x[2] = node.z;
    sbi_export_reals(out, x, 3);
}

/* ---- VTK ---- */

#define SBI_EXPORT_REAL_NAME (SB_REAL_IS_FLOAT ? "float" : "double")

/* A line of text with a number, in binary files too. */
static void sbi_export_line(sbi_export *out, const char *keyword, long long number, const char *after)
{
    char text[32];
    snprintf(text, sizeof text, " %lld", number);
    sbi_export_text(out, keyword);
    sbi_export_text(out, text);
    sbi_export_text(out, after);
}

/* VTK reads binary numbers up to their last byte and then looks for the next line. */
static void sbi_export_end_binary(sbi_export *out)
{
    if (out->binary)
        sbi_export_text(out, "\n");
}

static sb_result sbi_export_check_field(const sb_field *field, const sb_mesh *mesh, sb_error *error)
{
    static const char usable[] = {1, 2, 3, 4, 6, 9};
    int at_nodes = field->location == SB_FIELD_NODES, known = 0;
    size_t rows = (size_t)(at_nodes ? mesh->node_count : mesh->element_count);
    if (!field->name || !field->name[0] || !field->values)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a field without a name or values");
    for (const char *p = field->name; *p; p++)
        if (*p <= ' ' || *p > '~')
            return sbi_fail(error, SB_ERROR_ARGUMENT, "the field name '%s' has characters VTK cannot hold",
                            field->name);
    if (!at_nodes && field->location != SB_FIELD_ELEMENTS)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "field %s: unknown location", field->name);
    for (size_t i = 0; i < sizeof usable; i++)
        known |= field->components == usable[i];
    if (!known)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "field %s: %d components", field->name, field->components);
    for (size_t i = 0; i < rows * (size_t)field->components; i++)
        if (!sb_is_finite(field->values[i])) {
            int row = (int)(i / (size_t)field->components);
            return at_nodes
                       ? sbi_fail_node(error, SB_ERROR_NOT_FINITE, row, "field %s is not finite", field->name)
                       : sbi_fail_element(error, SB_ERROR_NOT_FINITE, row, "field %s is not finite",
                                          field->name);
        }
    if (!at_nodes && mesh->regions && strcmp(field->name, "region") == 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the element field region comes from the mesh");
    return SB_OK;
}

static void sbi_export_field(sbi_export *out, const sb_field *field, int rows)
{
    int components = field->components;
    int is_vector = components == 3, is_tensor = components > 4;
    sbi_export_text(out, is_vector ? "VECTORS " : is_tensor ? "TENSORS " : "SCALARS ");
    sbi_export_text(out, field->name);
    sbi_export_text(out, " ");
    if (is_vector || is_tensor) {
        sbi_export_text(out, SBI_EXPORT_REAL_NAME);
        sbi_export_text(out, "\n");
    } else {
        sbi_export_line(out, SBI_EXPORT_REAL_NAME, components, "\nLOOKUP_TABLE default\n");
    }
    for (int i = 0; i < rows; i++) {
        const sb_real *value = field->values + (size_t)i * (size_t)components;
        static const int symmetric[9] = {0, 3, 5, 3, 1, 4, 5, 4, 2}; /* of xx yy zz xy yz xz */
        sb_real full[9];
        for (int k = 0; k < 9 && components == 6; k++)
            full[k] = value[symmetric[k]];
        sbi_export_reals(out, components == 6 ? full : value, components == 6 ? 9 : components);
    }
    sbi_export_end_binary(out);
}

/* The section POINT_DATA or CELL_DATA, when there is anything for it. */
static void sbi_export_data(sbi_export *out, const sb_mesh *mesh, const sb_field *fields, int field_count,
                            sb_field_location location)
{
    int at_nodes = location == SB_FIELD_NODES, rows = at_nodes ? mesh->node_count : mesh->element_count;
    int with_regions = !at_nodes && mesh->regions, any = with_regions;
    for (int i = 0; i < field_count; i++)
        any |= fields[i].location == location;
    if (!any)
        return;
    sbi_export_line(out, at_nodes ? "POINT_DATA" : "CELL_DATA", rows, "\n");
    if (with_regions) {
        sbi_export_text(out, "SCALARS region int 1\nLOOKUP_TABLE default\n");
        for (int i = 0; i < rows; i++)
            sbi_export_integer(out, mesh->regions[i], "\n");
        sbi_export_end_binary(out);
    }
    for (int i = 0; i < field_count; i++)
        if (fields[i].location == location)
            sbi_export_field(out, &fields[i], rows);
}

/* VTK's number of an element type. */
static int sbi_export_vtk_type(sb_element_type type)
{
    for (int kind = 0; kind < SBI_CELL_KINDS; kind++)
        if (sbi_cell_kind_at(kind)->type == type)
            return sbi_cell_kind_at(kind)->vtk;
    return 0;
}

static void sbi_export_vtk_mesh(sbi_export *out, const sb_mesh *mesh)
{
    int nodes = sb_element_node_count(mesh->element_type), type = sbi_export_vtk_type(mesh->element_type);
    sbi_export_text(out, "# vtk DataFile Version 3.0\nsoftbody mesh (metre)\n");
    sbi_export_text(out, out->binary ? "BINARY\n" : "ASCII\n");
    sbi_export_text(out, "DATASET UNSTRUCTURED_GRID\n");
    sbi_export_line(out, "POINTS", mesh->node_count, " ");
    sbi_export_text(out, SBI_EXPORT_REAL_NAME);
    sbi_export_text(out, "\n");
    for (int i = 0; i < mesh->node_count; i++)
        sbi_export_node(out, mesh->nodes[i]);
    sbi_export_end_binary(out);
    sbi_export_line(out, "CELLS", mesh->element_count, "");
    sbi_export_line(out, "", (long long)mesh->element_count * (nodes + 1), "\n");
    for (int i = 0; i < mesh->element_count; i++) {
        sbi_export_integer(out, nodes, " ");
        for (int k = 0; k < nodes; k++)
            sbi_export_integer(out, mesh->elements[(size_t)i * (size_t)nodes + (size_t)k],
                               k + 1 < nodes ? " " : "\n");
    }
    sbi_export_end_binary(out);
    sbi_export_line(out, "CELL_TYPES", mesh->element_count, "\n");
    for (int i = 0; i < mesh->element_count; i++)
        sbi_export_integer(out, type, "\n");
    sbi_export_end_binary(out);
}

static sb_result sbi_export_vtk(const char *path, const sb_mesh *mesh, const sb_field *fields,
                                int field_count, int binary, sb_error *error)
{
    sbi_export out;
    sb_result result;
    if (!path || !mesh || field_count < 0 || (field_count > 0 && !fields))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s",
                        field_count < 0 ? "a negative number of fields" : "path, mesh or fields is NULL");
    result = sbi_mesh_check_arrays(mesh, error);
    for (int i = 0; i < field_count && !result; i++)
        result = sbi_export_check_field(&fields[i], mesh, error);
    if (!result)
        result = sbi_export_open(&out, path, binary, error);
    if (result)
        return result;
    sbi_export_vtk_mesh(&out, mesh);
    sbi_export_data(&out, mesh, fields, field_count, SB_FIELD_ELEMENTS);
    sbi_export_data(&out, mesh, fields, field_count, SB_FIELD_NODES);
    return sbi_export_close(&out, error);
}

SB_API sb_result sb_mesh_save_vtk(const char *path, const sb_mesh *mesh, const sb_field *fields,
                                  int field_count, sb_error *error)
{
    return sbi_export_vtk(path, mesh, fields, field_count, 0, error);
}

SB_API sb_result sb_mesh_save_vtk_binary(const char *path, const sb_mesh *mesh, const sb_field *fields,
                                         int field_count, sb_error *error)
{
    return sbi_export_vtk(path, mesh, fields, field_count, 1, error);
}

/* ---- surfaces ---- */

static sb_result sbi_export_check_surface(const char *path, const sb_mesh *mesh, sb_error *error)
{
    sb_result result;
    if (!path || !mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "path or mesh is NULL");
    result = sbi_mesh_check_arrays(mesh, error);
    if (result)
        return result;
    if (mesh->element_type == SB_TRI3 || mesh->element_type == SB_QUAD4)
        return SB_OK;
    if (mesh->element_type == SB_TRI6)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "curved triangles (tri6) cannot be written as a surface file");
    return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                    "a volume mesh cannot be written as a surface file: write its sb_mesh_boundary");
}

/* The nodes of element i. */
static const int *sbi_export_element(const sb_mesh *mesh, int i)
{
    return mesh->elements + (size_t)i * (size_t)sb_element_node_count(mesh->element_type);
}

SB_API sb_result sb_mesh_save_obj(const char *path, const sb_mesh *mesh, sb_error *error)
{
    sbi_export out;
    int nodes;
    sb_result result = sbi_export_check_surface(path, mesh, error);
    if (!result)
        result = sbi_export_open(&out, path, 0, error);
    if (result)
        return result;
    nodes = sb_element_node_count(mesh->element_type);
    for (int i = 0; i < mesh->node_count; i++) {
        sbi_export_text(&out, "v ");
        sbi_export_node(&out, mesh->nodes[i]);
    }
    for (int i = 0; i < mesh->element_count; i++) {
        const int *element = sbi_export_element(mesh, i);
        sbi_export_text(&out, "f ");
        for (int k = 0; k < nodes; k++)
            sbi_export_line(&out, "", (long long)element[k] + 1, k + 1 < nodes ? "" : "\n");
    }
    return sbi_export_close(&out, error);
}

/* A facet of binary STL: normal, three corners, two bytes of nothing. */
static void sbi_export_facet(sbi_export *out, const sb_mesh *mesh, int a, int b, int c)
{
    sb_vec3 corners[4];
    sb_real length;
    corners[1] = mesh->nodes[a];
    corners[2] = mesh->nodes[b];
    corners[3] = mesh->nodes[c];
    corners[0] = sb_v3_cross(sb_v3_sub(corners[2], corners[1]), sb_v3_sub(corners[3], corners[1]));
    length = sb_v3_norm(corners[0]);
    corners[0] = length > 0 && sb_is_finite(length) ? sb_v3_scale(1 / length, corners[0]) : sb_v3(0, 0, 0);
    for (int i = 0; i < 4; i++) {
        sbi_export_bits(out, sbi_export_float_bits((float)corners[i].x), 4, 0);
        sbi_export_bits(out, sbi_export_float_bits((float)corners[i].y), 4, 0);
        sbi_export_bits(out, sbi_export_float_bits((float)corners[i].z), 4, 0);
    }
    sbi_export_bits(out, 0, 2, 0);
}

SB_API sb_result sb_mesh_save_stl(const char *path, const sb_mesh *mesh, sb_error *error)
{
    const double limit = (double)FLT_MAX;
    char header[80];
    sbi_export out;
    int quads;
    sb_result result = sbi_export_check_surface(path, mesh, error);
    for (int i = 0; !result && i < mesh->node_count; i++) {
        sb_vec3 x = mesh->nodes[i];
        if (fabs((double)x.x) > limit || fabs((double)x.y) > limit || fabs((double)x.z) > limit)
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i,
                                 "a coordinate of node %d is too large for STL", i);
    }
    if (!result)
        result = sbi_export_open(&out, path, 1, error);
    if (result)
        return result;
    quads = mesh->element_type == SB_QUAD4;
    memset(header, ' ', sizeof header);
    memcpy(header, "binary STL (metre)", 18); /* must not begin with "solid", the mark of the ASCII form */
    sbi_export_bytes(&out, header, sizeof header);
    sbi_export_bits(&out, (uint64_t)mesh->element_count * (quads ? 2u : 1u), 4, 0);
    for (int i = 0; i < mesh->element_count; i++) {
        const int *element = sbi_export_element(mesh, i);
        sbi_export_facet(&out, mesh, element[0], element[1], element[2]);
        if (quads)
            sbi_export_facet(&out, mesh, element[0], element[2], element[3]);
    }
    return sbi_export_close(&out, error);
}

SB_API sb_result sb_mesh_save_ply(const char *path, const sb_mesh *mesh, sb_error *error)
{
    sbi_export out;
    int nodes;
    sb_result result = sbi_export_check_surface(path, mesh, error);
    if (!result)
        result = sbi_export_open(&out, path, 1, error);
    if (result)
        return result;
    nodes = sb_element_node_count(mesh->element_type);
    sbi_export_text(&out, "ply\nformat binary_little_endian 1.0\ncomment unit: metre\n");
    sbi_export_line(&out, "element vertex", mesh->node_count, "\n");
    for (char axis = 'x'; axis <= 'z'; axis++) {
        char property[32];
        snprintf(property, sizeof property, "property %s %c\n", SBI_EXPORT_REAL_NAME, axis);
        sbi_export_text(&out, property);
    }
    sbi_export_line(&out, "element face", mesh->element_count,
                    "\nproperty list uchar int vertex_indices\nend_header\n");
    for (int i = 0; i < mesh->node_count; i++) {
        sbi_export_bits(&out, sbi_export_real_bits(mesh->nodes[i].x), (int)sizeof(sb_real), 0);
        sbi_export_bits(&out, sbi_export_real_bits(mesh->nodes[i].y), (int)sizeof(sb_real), 0);
        sbi_export_bits(&out, sbi_export_real_bits(mesh->nodes[i].z), (int)sizeof(sb_real), 0);
    }
    for (int i = 0; i < mesh->element_count; i++) {
        const int *element = sbi_export_element(mesh, i);
        sbi_export_bits(&out, (uint64_t)nodes, 1, 0);
        for (int k = 0; k < nodes; k++)
            sbi_export_bits(&out, (uint64_t)element[k], 4, 0);
    }
    return sbi_export_close(&out, error);
}
#undef SBI_EXPORT_REAL_NAME

/* ==== src/softbody/meshio_vtk.c ==== */
/* meshio_vtk: reads legacy VTK files, versions 2.0 to 5.1, ASCII and binary (which is always big-endian).
 * Source of the format: "VTK File Formats", The VTK User's Guide. Since 5.0 cells are lists of offsets and
 * of node indices; before, each cell's indices follow their count. */

#include <limits.h>
#include <string.h>

/* A type of values, as spelled in the file. */
typedef struct sbi_vtk_type {
    char name[20];
    char class_; /* i signed, u unsigned, f floating, b bits, s text of one line each */
    int size;    /* bytes in binary files */
} sbi_vtk_type;

typedef struct sbi_vtk {
    sbi_loader *loader;
    sbi_reader *reader;
    int binary, polydata;
    int has_points, has_cells, has_types;
    int cell_count; /* cells of the list read last, which lie in: */
    int *ends;      /* [cell_count] where the nodes of each cell end */
    int *nodes;
    int category; /* polydata: the last section; cell data counts vertices, lines, polygons, strips */
    int out_of_order;
    int in_cell_data;
    int data_count; /* tuples of the point or cell data being read; -1: outside */
} sbi_vtk;

static const sbi_vtk_type *sbi_vtk_find_type(sbi_word word)
{
    /* vtkIdType is written as a 32-bit integer. */
    static const sbi_vtk_type types[] = {{"float", 'f', 4},
                                         {"double", 'f', 8},
                                         {"int", 'i', 4},
                                         {"unsigned_int", 'u', 4},
                                         {"vtktypeint64", 'i', 8},
                                         {"vtktypeuint64", 'u', 8},
                                         {"vtkIdType", 'i', 4},
                                         {"long", 'i', 8},
                                         {"unsigned_long", 'u', 8},
                                         {"short", 'i', 2},
                                         {"unsigned_short", 'u', 2},
                                         {"char", 'i', 1},
                                         {"signed_char", 'i', 1},
                                         {"unsigned_char", 'u', 1},
                                         {"vtktypeint32", 'i', 4},
                                         {"vtktypeuint32", 'u', 4},
                                         {"vtktypeint16", 'i', 2},
                                         {"vtktypeuint16", 'u', 2},
                                         {"vtktypeint8", 'i', 1},
                                         {"vtktypeuint8", 'u', 1},
                                         {"long_long", 'i', 8},
                                         {"unsigned_long_long", 'u', 8},
                                         {"bit", 'b', 0},
                                         {"string", 's', 0},
                                         {"utf8_string", 's', 0},
                                         {"variant", 's', 0}};
    for (size_t i = 0; i < sizeof types / sizeof types[0]; i++)
        if (sbi_word_is(word, types[i].name))
            return &types[i];
    return NULL;
}

static sb_result sbi_vtk_read_type(sbi_vtk *vtk, const sbi_vtk_type **type)
{
    sbi_word word;
    char text[32];
    if (!sbi_reader_line_word(vtk->reader, &word))
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the data type is missing");
    *type = sbi_vtk_find_type(word);
    if (!*type)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "'%s' is not a data type",
                               sbi_word_print(word, text));
    return SB_OK;
}

/* ---- values ---- */

/* Steps to the data behind a keyword line. */
static void sbi_vtk_start_data(sbi_vtk *vtk)
{
    if (vtk->binary)
        sbi_reader_next_line(vtk->reader);
}

/* Bytes a value takes at least: a digit and a blank in a text. */
static size_t sbi_vtk_value_bytes(const sbi_vtk *vtk, const sbi_vtk_type *type)
{
    return vtk->binary ? (size_t)type->size : 2;
}

static sb_result sbi_vtk_real(sbi_vtk *vtk, const sbi_vtk_type *type, const char *what, double *value)
{
    const unsigned char *bytes;
    if (!vtk->binary)
        return sbi_reader_real(vtk->reader, what, value);
    bytes = sbi_reader_bytes(vtk->reader, 1, (size_t)type->size, what);
    if (!bytes)
        return SB_ERROR_FORMAT;
    if (type->class_ == 'f')
        *value = sbi_decode_float(vtk->reader, bytes, type->size);
    else if (type->class_ == 'i')
        *value = (double)sbi_decode_signed(vtk->reader, bytes, type->size);
    else
        *value = (double)sbi_decode_bits(vtk->reader, bytes, type->size);
    return SB_OK;
}

static sb_result sbi_vtk_integer(sbi_vtk *vtk, const sbi_vtk_type *type, const char *what, int64_t *value)
{
    const unsigned char *bytes;
    uint64_t bits;
    if (!vtk->binary)
        return sbi_reader_integer(vtk->reader, what, value);
    bytes = sbi_reader_bytes(vtk->reader, 1, (size_t)type->size, what);
    if (!bytes)
        return SB_ERROR_FORMAT;
    bits = sbi_decode_bits(vtk->reader, bytes, type->size);
    if (type->class_ == 'i')
        *value = sbi_decode_signed(vtk->reader, bytes, type->size);
    else if (bits <= (uint64_t)INT64_MAX)
        *value = (int64_t)bits;
    else
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "%s is too large", what);
    return SB_OK;
}

static sb_result sbi_vtk_skip_values(sbi_vtk *vtk, const sbi_vtk_type *type, int64_t count)
{
    if (type->class_ == 's') {
        if (vtk->binary)
            return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED,
                                   "text arrays in binary files are not supported");
        for (sbi_reader_next_line(vtk->reader); count > 0; count--) {
            if (!sbi_reader_left(vtk->reader))
                return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the file ends in a text array");
            sbi_reader_next_line(vtk->reader);
        }
        return SB_OK;
    }
    sbi_vtk_start_data(vtk);
    if ((uint64_t)count > (uint64_t)sbi_reader_left(vtk->reader) * 8)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the file is too short for %lld values",
                               (long long)count);
    if (!vtk->binary)
        return sbi_reader_skip_words(vtk->reader, (size_t)count, "a data array");
    if (type->class_ == 'b')
        return sbi_reader_bytes(vtk->reader, (size_t)(count + 7) / 8, 1, "a data array") ? SB_OK
                                                                                         : SB_ERROR_FORMAT;
    return sbi_reader_bytes(vtk->reader, (size_t)count, (size_t)type->size, "a data array") ? SB_OK
                                                                                            : SB_ERROR_FORMAT;
}

/* ---- geometry ---- */

static sb_result sbi_vtk_points(sbi_vtk *vtk)
{
    const sbi_vtk_type *type = NULL;
    int64_t claimed = 0;
    int count = 0;
    sb_result result;
    if (vtk->has_points)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "a second POINTS section");
    result = sbi_reader_integer(vtk->reader, "the number of points", &claimed);
    if (!result)
        result = sbi_vtk_read_type(vtk, &type);
    if (!result && (type->class_ == 'b' || type->class_ == 's'))
        return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED, "points of type %s", type->name);
    if (result)
        return result;
    sbi_vtk_start_data(vtk);
    result = sbi_reader_check_count(vtk->reader, "the number of points", claimed,
                                    3 * sbi_vtk_value_bytes(vtk, type), &count);
    if (!result)
        result = sbi_loader_reserve_nodes(vtk->loader, count);
    for (int i = 0; i < count && !result; i++) {
        double x[3] = {0, 0, 0};
        vtk->reader->node = i;
        for (int k = 0; k < 3 && !result; k++)
            result = sbi_vtk_real(vtk, type, "coordinate", &x[k]);
        if (!result)
            result = sbi_loader_add_node(vtk->loader, x);
    }
    vtk->has_points = 1;
    return result;
}

static void sbi_vtk_free_list(sbi_vtk *vtk)
{
    sbi_free(&vtk->loader->allocator, vtk->ends);
    sbi_free(&vtk->loader->allocator, vtk->nodes);
    vtk->ends = vtk->nodes = NULL;
    vtk->cell_count = 0;
}

/* Memory for a list of cells with `indices` node indices together. */
static sb_result sbi_vtk_take_list(sbi_vtk *vtk, int cells, int indices)
{
    if (cells > INT_MAX - vtk->loader->source_count)
        return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 cells");
    vtk->ends = (int *)sbi_alloc(&vtk->loader->allocator, (size_t)cells, sizeof(int));
    vtk->nodes = (int *)sbi_alloc(&vtk->loader->allocator, (size_t)indices, sizeof(int));
    vtk->cell_count = cells;
    return vtk->ends && vtk->nodes ? SB_OK : sbi_loader_no_memory(vtk->loader);
}

static sb_result sbi_vtk_node_index(sbi_vtk *vtk, const sbi_vtk_type *type, int *node)
{
    int64_t value = 0;
    sb_result result = sbi_vtk_integer(vtk, type, "node index", &value);
    if (result)
        return result;
    if (value < 0 || value >= (int64_t)vtk->loader->node_count)
        return sbi_reader_fail(vtk->reader, SB_ERROR_INDEX,
                               "cell %d refers to node %lld, but there are %llu nodes", vtk->reader->element,
                               (long long)value, (unsigned long long)vtk->loader->node_count);
    *node = (int)value;
    return SB_OK;
}

/* n times: count, node, node ...; `size` numbers together. */
static sb_result sbi_vtk_counted_list(sbi_vtk *vtk, int64_t claimed_cells, int64_t claimed_size)
{
    static const sbi_vtk_type type = {"int", 'i', 4};
    int cells = 0, size = 0, used = 0, left;
    sb_result result;
    sbi_vtk_start_data(vtk);
    result = sbi_reader_check_count(vtk->reader, "the number of cells", claimed_cells,
                                    sbi_vtk_value_bytes(vtk, &type), &cells);
    if (!result)
        result = sbi_reader_check_count(vtk->reader, "the size of the cell list", claimed_size,
                                        sbi_vtk_value_bytes(vtk, &type), &size);
    if (!result && size < cells)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "a list of %d numbers cannot hold %d cells",
                               size, cells);
    if (!result)
        result = sbi_vtk_take_list(vtk, cells, size - cells);
    left = size - cells;
    for (int i = 0; i < cells && !result; i++) {
        int64_t count = 0;
        vtk->reader->element = vtk->loader->source_count + i;
        result = sbi_vtk_integer(vtk, &type, "the number of nodes of a cell", &count);
        if (!result && (count < 0 || count > left - used))
            return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT,
                                   "cell %d has %lld nodes, which does not fit the size of the list, %d",
                                   vtk->reader->element, (long long)count, size);
        for (int64_t k = 0; k < count && !result; k++)
            result = sbi_vtk_node_index(vtk, &type, &vtk->nodes[used++]);
        if (!result)
            vtk->ends[i] = used;
    }
    if (!result && used != left)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT,
                               "the cells take %d numbers, but the list should have %d", cells + used, size);
    vtk->reader->element = -1;
    return result;
}

/* The keyword of an array of a 5.x list and its integer type. */
static sb_result sbi_vtk_list_array(sbi_vtk *vtk, const char *keyword, const sbi_vtk_type **type)
{
    sbi_word word;
    sb_result result;
    if (!sbi_reader_word(vtk->reader, &word) || !sbi_word_is(word, keyword))
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "%s is missing", keyword);
    result = sbi_vtk_read_type(vtk, type);
    if (!result && (*type)->class_ != 'i' && (*type)->class_ != 'u')
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "%s of type %s", keyword, (*type)->name);
    if (!result)
        sbi_vtk_start_data(vtk);
    return result;
}

/* OFFSETS: one number more than cells, from 0, ascending; then CONNECTIVITY. */
static sb_result sbi_vtk_offset_list(sbi_vtk *vtk, int64_t claimed_offsets, int64_t claimed_indices)
{
    const sbi_vtk_type *type = NULL;
    int offsets = 0, indices = 0;
    int64_t last = 0;
    sb_result result = sbi_vtk_list_array(vtk, "OFFSETS", &type);
    if (!result)
        result = sbi_reader_check_count(vtk->reader, "the number of offsets", claimed_offsets,
                                        sbi_vtk_value_bytes(vtk, type), &offsets);
    if (!result)
        result = sbi_reader_check_count(vtk->reader, "the number of node indices", claimed_indices,
                                        vtk->binary ? 1 : 2, &indices);
    if (!result && offsets == 0)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "a list of cells without offsets");
    if (!result)
        result = sbi_vtk_take_list(vtk, offsets - 1, indices);
    for (int i = 0; i < offsets && !result; i++) {
        int64_t offset = 0;
        vtk->reader->element = vtk->loader->source_count + (i > 0 ? i - 1 : 0);
        result = sbi_vtk_integer(vtk, type, "offset", &offset);
        if (!result && (offset < last || offset > indices || (i == 0 && offset != 0)))
            return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT,
                                   "offset %d is %lld, which is out of order or range", i, (long long)offset);
        last = offset;
        if (i > 0 && !result)
            vtk->ends[i - 1] = (int)offset;
    }
    vtk->reader->element = -1;
    if (!result && last != indices)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT,
                               "the last offset is %lld, but there are %d node indices", (long long)last,
                               indices);
    if (!result)
        result = sbi_vtk_list_array(vtk, "CONNECTIVITY", &type);
    for (int i = 0, cell = 0; i < indices && !result; i++) {
        while (vtk->ends[cell] <= i)
            cell++;
        vtk->reader->element = vtk->loader->source_count + cell;
        result = sbi_vtk_node_index(vtk, type, &vtk->nodes[i]);
    }
    vtk->reader->element = -1;
    return result;
}

/* A list of cells in either form, after its keyword. */
static sb_result sbi_vtk_cell_list(sbi_vtk *vtk)
{
    int64_t cells = 0, size = 0;
    sbi_word word;
    sb_result result = sbi_reader_integer(vtk->reader, "the number of cells", &cells);
    if (!result)
        result = sbi_reader_integer(vtk->reader, "the size of the cell list", &size);
    if (result)
        return result;
    if (!vtk->has_points)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "cells before POINTS");
    /* In a binary file, bytes that read OFFSETS would be an impossible number of nodes. */
    if (sbi_reader_peek(vtk->reader, &word) && sbi_word_is(word, "OFFSETS"))
        return sbi_vtk_offset_list(vtk, cells, size);
    return sbi_vtk_counted_list(vtk, cells, size);
}

/* Hands cell i of the list to the loader. */
static sb_result sbi_vtk_commit_cell(sbi_vtk *vtk, int i, int kind)
{
    const sbi_cell_kind *about = sbi_cell_kind_at(kind);
    sb_result result = SB_OK;
    sbi_loader_begin_cell(vtk->loader);
    for (int k = i ? vtk->ends[i - 1] : 0; k < vtk->ends[i] && !result; k++)
        result = sbi_loader_cell_node(vtk->loader, vtk->nodes[k], 0);
    if (result)
        return result;
    if (about->vtk == 7)
        return sbi_loader_end_polygon(vtk->loader, 0);
    if (about->vtk == 6)
        return sbi_loader_end_strip(vtk->loader, 0);
    return sbi_loader_end_cell(vtk->loader, kind, about->vtk_order, 0);
}

static sb_result sbi_vtk_cell_types(sbi_vtk *vtk)
{
    static const sbi_vtk_type type = {"int", 'i', 4};
    int64_t claimed = 0;
    sb_result result = sbi_reader_integer(vtk->reader, "the number of cell types", &claimed);
    if (result)
        return result;
    if (!vtk->has_cells || vtk->has_types)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "CELL_TYPES without CELLS before it");
    if (claimed != vtk->cell_count)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "%lld cell types for %d cells",
                               (long long)claimed, vtk->cell_count);
    sbi_vtk_start_data(vtk);
    for (int i = 0; i < vtk->cell_count && !result; i++) {
        int64_t number = 0;
        int kind;
        vtk->reader->element = i;
        result = sbi_vtk_integer(vtk, &type, "cell type", &number);
        kind = sbi_cell_kind_of_vtk(number);
        if (!result && kind < 0)
            return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED, "cell %d has the unknown VTK type %lld",
                                   i, (long long)number);
        if (!result)
            result = sbi_vtk_commit_cell(vtk, i, kind);
    }
    sbi_vtk_free_list(vtk);
    vtk->reader->element = -1;
    vtk->has_types = 1;
    return result;
}

static sb_result sbi_vtk_cells(sbi_vtk *vtk)
{
    if (vtk->has_cells || vtk->polydata)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "CELLS where none should be");
    vtk->has_cells = 1;
    return sbi_vtk_cell_list(vtk);
}

/* A section of polydata whose cells are all of the VTK type. */
static sb_result sbi_vtk_poly_cells(sbi_vtk *vtk, int category, int vtk_type)
{
    sb_result result;
    if (!vtk->polydata)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "a section of POLYDATA in another data set");
    if (category <= vtk->category)
        vtk->out_of_order = 1;
    vtk->category = category;
    result = sbi_vtk_cell_list(vtk);
    for (int i = 0; i < vtk->cell_count && !result; i++)
        result = sbi_vtk_commit_cell(vtk, i, sbi_cell_kind_of_vtk(vtk_type));
    sbi_vtk_free_list(vtk);
    vtk->has_cells = vtk->has_types = 1;
    return result;
}

/* ---- data arrays ---- */

static sb_result sbi_vtk_read_regions(sbi_vtk *vtk, const sbi_vtk_type *type)
{
    sbi_loader *loader = vtk->loader;
    sb_result result = SB_OK;
    if (vtk->out_of_order)
        return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED,
                               "regions of polydata whose sections are not in the order of VTK");
    if (type->class_ == 'b' || type->class_ == 's')
        return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED, "regions of type %s", type->name);
    loader->source_regions = (int *)sbi_alloc(&loader->allocator, (size_t)loader->source_count, sizeof(int));
    if (!loader->source_regions)
        return sbi_loader_no_memory(loader);
    sbi_vtk_start_data(vtk);
    for (int i = 0; i < loader->source_count && !result; i++) {
        double value = 0;
        vtk->reader->element = i;
        result = sbi_vtk_real(vtk, type, "region", &value);
        if (!result && !(value >= INT_MIN && value <= INT_MAX && value == (double)(int)value))
            return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT,
                                   "the region of cell %d is not an integer: %g", i, value);
        loader->source_regions[i] = (int)value;
    }
    vtk->reader->element = -1;
    return result;
}

/* The values of an array, after its keyword line up to the type: regions are kept, others skipped. */
static sb_result sbi_vtk_array(sbi_vtk *vtk, sbi_word name, const sbi_vtk_type *type, int64_t components,
                               int64_t tuples)
{
    if (components < 0 || tuples < 0 || components > INT_MAX || tuples > INT_MAX)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "an array of %lld times %lld values",
                               (long long)tuples, (long long)components);
    if (vtk->in_cell_data && sbi_word_is(name, "region") && !vtk->loader->source_regions) {
        if (components != 1 || tuples != vtk->loader->source_count)
            return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT,
                                   "the field region must have one value per cell");
        return sbi_vtk_read_regions(vtk, type);
    }
    return sbi_vtk_skip_values(vtk, type, components * tuples);
}

/* A line of information, up to the next blank line. */
static void sbi_vtk_metadata(sbi_vtk *vtk)
{
    do
        sbi_reader_next_line(vtk->reader);
    while (sbi_reader_left(vtk->reader) && !sbi_reader_at_line_end(vtk->reader));
}

static sb_result sbi_vtk_field(sbi_vtk *vtk)
{
    sbi_word name;
    int arrays = 0;
    sb_result result;
    if (!sbi_reader_line_word(vtk->reader, &name))
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "FIELD without a name");
    result = sbi_reader_count(vtk->reader, "the number of arrays", 2, &arrays);
    for (int i = 0; i < arrays && !result;) {
        const sbi_vtk_type *type = NULL;
        int64_t components = 0, tuples = 0;
        if (!sbi_reader_word(vtk->reader, &name))
            return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the file ends in FIELD");
        if (sbi_word_is(name, "METADATA")) {
            sbi_vtk_metadata(vtk);
            continue;
        }
        i++;
        if (sbi_word_is(name, "NULL_ARRAY"))
            continue;
        result = sbi_reader_integer(vtk->reader, "the number of components", &components);
        if (!result)
            result = sbi_reader_integer(vtk->reader, "the number of tuples", &tuples);
        if (!result)
            result = sbi_vtk_read_type(vtk, &type);
        if (!result)
            result = sbi_vtk_array(vtk, name, type, components, tuples);
    }
    return result;
}

/* Steps over the line LOOKUP_TABLE that follows a SCALARS line. */
static void sbi_vtk_skip_table_name(sbi_vtk *vtk)
{
    static const char keyword[] = "LOOKUP_TABLE";
    sbi_word word;
    sbi_reader ahead = *vtk->reader;
    sbi_reader_next_line(&ahead);
    if (!vtk->binary)
        sbi_reader_at_line_end(
            &ahead); /* steps over blanks; binary data may begin with bytes that look like them */
    word.text = ahead.data + ahead.at;
    word.length = sizeof keyword - 1;
    if (sbi_reader_left(&ahead) <= word.length || !sbi_word_is(word, keyword))
        return;
    vtk->reader->at = ahead.at + word.length;
    vtk->reader->line = ahead.line;
    if (!vtk->binary)
        sbi_reader_next_line(vtk->reader);
}

static sb_result sbi_vtk_scalars(sbi_vtk *vtk, sbi_word name)
{
    const sbi_vtk_type *type = NULL;
    int64_t components = 1;
    sb_result result = sbi_vtk_read_type(vtk, &type);
    if (!result && !sbi_reader_at_line_end(vtk->reader))
        result = sbi_reader_integer(vtk->reader, "the number of components", &components);
    if (result)
        return result;
    sbi_vtk_skip_table_name(vtk);
    return sbi_vtk_array(vtk, name, type, components, vtk->data_count);
}

/* COLOR_SCALARS and LOOKUP_TABLE: bytes in binary files, numbers in [0, 1] else. */
static sb_result sbi_vtk_colours(sbi_vtk *vtk, sbi_word name, int is_table)
{
    static const sbi_vtk_type bytes = {"unsigned_char", 'u', 1};
    int64_t count = 0;
    sb_result result = sbi_reader_integer(vtk->reader, "the number of colours", &count);
    name.length = 0; /* colours are no regions, whatever their name */
    if (result)
        return result;
    return sbi_vtk_array(vtk, name, &bytes, is_table ? 4 : count, is_table ? count : vtk->data_count);
}

static sb_result sbi_vtk_tuples(sbi_vtk *vtk, sbi_word name, int64_t components)
{
    const sbi_vtk_type *type = NULL;
    sb_result result = SB_OK;
    if (components < 0) /* texture coordinates tell their own */
        result = sbi_reader_integer(vtk->reader, "the number of components", &components);
    if (!result)
        result = sbi_vtk_read_type(vtk, &type);
    return result ? result : sbi_vtk_array(vtk, name, type, components, vtk->data_count);
}

/* A data array, after its keyword; 0 in *known when the keyword is none of an array. */
static sb_result sbi_vtk_attribute(sbi_vtk *vtk, sbi_word keyword, int *known)
{
    static const struct {
        char keyword[20];
        int components;
    } tuples[] = {{"VECTORS", 3},    {"NORMALS", 3},    {"TENSORS", 9},      {"TENSORS6", 6},
                  {"GLOBAL_IDS", 1}, {"EDGE_FLAGS", 1}, {"PEDIGREE_IDS", 1}, {"TEXTURE_COORDINATES", -1}};
    int is_table = sbi_word_is(keyword, "LOOKUP_TABLE"), scalars = sbi_word_is(keyword, "SCALARS");
    int colours = is_table || sbi_word_is(keyword, "COLOR_SCALARS"), row = -1;
    sbi_word name;
    for (int i = 0; i < (int)(sizeof tuples / sizeof tuples[0]); i++)
        if (sbi_word_is(keyword, tuples[i].keyword))
            row = i;
    *known = scalars || colours || row >= 0;
    if (!*known)
        return SB_OK;
    if (vtk->data_count < 0)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "an array before POINT_DATA or CELL_DATA");
    if (!sbi_reader_line_word(vtk->reader, &name))
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "an array without a name");
    if (scalars)
        return sbi_vtk_scalars(vtk, name);
    return colours ? sbi_vtk_colours(vtk, name, is_table) : sbi_vtk_tuples(vtk, name, tuples[row].components);
}

/* POINT_DATA or CELL_DATA. */
static sb_result sbi_vtk_data(sbi_vtk *vtk, int of_cells)
{
    int64_t count = 0, expected = of_cells ? vtk->loader->source_count : (int64_t)vtk->loader->node_count;
    sb_result result = sbi_reader_integer(vtk->reader, "the number of values", &count);
    if (!result && count != expected)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "data of %lld %s, but there are %lld",
                               (long long)count, of_cells ? "cells" : "points", (long long)expected);
    vtk->in_cell_data = of_cells;
    vtk->data_count = (int)expected;
    return result;
}

/* ---- file ---- */

static sb_result sbi_vtk_section(sbi_vtk *vtk, sbi_word keyword)
{
    char text[32];
    int known = 0;
    sb_result result;
    if (sbi_word_is(keyword, "POINTS"))
        return sbi_vtk_points(vtk);
    if (sbi_word_is(keyword, "CELLS"))
        return sbi_vtk_cells(vtk);
    if (sbi_word_is(keyword, "CELL_TYPES"))
        return sbi_vtk_cell_types(vtk);
    if (sbi_word_is(keyword, "VERTICES"))
        return sbi_vtk_poly_cells(vtk, 1, 2);
    if (sbi_word_is(keyword, "LINES"))
        return sbi_vtk_poly_cells(vtk, 2, 4);
    if (sbi_word_is(keyword, "POLYGONS"))
        return sbi_vtk_poly_cells(vtk, 3, 7);
    if (sbi_word_is(keyword, "TRIANGLE_STRIPS"))
        return sbi_vtk_poly_cells(vtk, 4, 6);
    if (sbi_word_is(keyword, "CELL_DATA"))
        return sbi_vtk_data(vtk, 1);
    if (sbi_word_is(keyword, "POINT_DATA"))
        return sbi_vtk_data(vtk, 0);
    if (sbi_word_is(keyword, "FIELD"))
        return sbi_vtk_field(vtk);
    if (sbi_word_is(keyword, "METADATA")) {
        sbi_vtk_metadata(vtk);
        return SB_OK;
    }
    result = sbi_vtk_attribute(vtk, keyword, &known);
    if (!known)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "'%s' where a section should begin",
                               sbi_word_print(keyword, text));
    return result;
}

/* "# vtk DataFile Version 3.0" */
static sb_result sbi_vtk_version(sbi_vtk *vtk)
{
    static const char magic[4][9] = {"#", "vtk", "DataFile", "Version"};
    sbi_word word;
    char text[32];
    for (int i = 0; i < 4; i++)
        if (!sbi_reader_line_word(vtk->reader, &word) || !sbi_word_is(word, magic[i]))
            return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT,
                                   "the first line is not \"# vtk DataFile Version\" with a number");
    if (!sbi_reader_line_word(vtk->reader, &word))
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the version number is missing");
    if (word.length < 3 || word.text[1] != '.' || word.text[0] < '2' || word.text[0] > '5')
        return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED,
                               "VTK version %s is not supported: 2.0 to 5.1 are", sbi_word_print(word, text));
    return SB_OK;
}

static sb_result sbi_vtk_header(sbi_vtk *vtk)
{
    sbi_word word;
    char text[32];
    sb_result result = sbi_vtk_version(vtk);
    if (result)
        return result;
    sbi_reader_next_line(vtk->reader);
    sbi_reader_next_line(vtk->reader); /* the title */
    if (!sbi_reader_word(vtk->reader, &word))
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the file ends in its header");
    vtk->binary = sbi_word_is(word, "BINARY");
    if (!vtk->binary && !sbi_word_is(word, "ASCII"))
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "'%s' instead of ASCII or BINARY",
                               sbi_word_print(word, text));
    if (!sbi_reader_word(vtk->reader, &word) || !sbi_word_is(word, "DATASET") ||
        !sbi_reader_line_word(vtk->reader, &word))
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "DATASET is missing");
    vtk->polydata = sbi_word_is(word, "POLYDATA");
    if (!vtk->polydata && !sbi_word_is(word, "UNSTRUCTURED_GRID"))
        return sbi_reader_fail(vtk->reader, SB_ERROR_UNSUPPORTED,
                               "data set %s: only UNSTRUCTURED_GRID and POLYDATA are read",
                               sbi_word_print(word, text));
    vtk->reader->binary = vtk->reader->big_endian = vtk->binary;
    return SB_OK;
}

static sb_result sbi_vtk_finish(const sbi_vtk *vtk)
{
    if (!vtk->has_points)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the file ends without POINTS");
    if (!vtk->has_cells)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the file ends without cells");
    if (!vtk->has_types)
        return sbi_reader_fail(vtk->reader, SB_ERROR_FORMAT, "the file ends without CELL_TYPES");
    return SB_OK;
}

SBI_API sb_result sbi_vtk_read(sbi_loader *loader)
{
    sbi_vtk vtk;
    sbi_word keyword;
    sb_result result;
    memset(&vtk, 0, sizeof vtk);
    vtk.loader = loader;
    vtk.reader = &loader->reader;
    vtk.data_count = -1;
    result = sbi_vtk_header(&vtk);
    while (!result && sbi_reader_word(vtk.reader, &keyword))
        result = sbi_vtk_section(&vtk, keyword);
    if (!result)
        result = sbi_vtk_finish(&vtk);
    sbi_vtk_free_list(&vtk);
    return result;
}

/* ==== src/softbody/meshio_gmsh.c ==== */
/* meshio_gmsh: reads gmsh meshes, versions 2.x and 4.1, ASCII and binary of either byte order.
 * Source of the format: Gmsh Reference Manual, "MSH file format" and "Legacy formats". */

#include <limits.h>
#include <string.h>

/* The first physical group of a geometric entity (4.1). */
typedef struct sbi_gmsh_entity {
    int64_t dimension, tag;
    int region;
} sbi_gmsh_entity;

typedef struct sbi_gmsh {
    sbi_loader *loader;
    sbi_reader *reader;
    int version;            /* 2 or 4 */
    int binary, size_bytes; /* bytes of a size_t in binary files */
    int has_nodes, has_elements;
    int64_t *tags; /* [nodes] number of each node in the file, any order and gaps */
    size_t tag_capacity;
    int *order; /* [nodes] nodes by ascending tag */
    sbi_gmsh_entity *entities;
    size_t entity_count, entity_capacity;
    int *entity_order; /* [entities] ascending by dimension and tag */
} sbi_gmsh;

/* ---- values: the same code reads text and binary ---- */

static sb_result sbi_gmsh_integer(sbi_gmsh *gmsh, const char *what, int64_t *value)
{
    const unsigned char *bytes;
    if (!gmsh->binary)
        return sbi_reader_integer(gmsh->reader, what, value);
    bytes = sbi_reader_bytes(gmsh->reader, 1, 4, what);
    if (!bytes)
        return SB_ERROR_FORMAT;
    *value = sbi_decode_signed(gmsh->reader, bytes, 4);
    return SB_OK;
}

/* A size_t of version 4.1: counts and tags of nodes and elements. */
static sb_result sbi_gmsh_size(sbi_gmsh *gmsh, const char *what, int64_t *value)
{
    const unsigned char *bytes;
    uint64_t bits;
    if (!gmsh->binary)
        return sbi_reader_integer(gmsh->reader, what, value);
    bytes = sbi_reader_bytes(gmsh->reader, 1, (size_t)gmsh->size_bytes, what);
    if (!bytes)
        return SB_ERROR_FORMAT;
    bits = sbi_decode_bits(gmsh->reader, bytes, gmsh->size_bytes);
    if (bits > (uint64_t)INT64_MAX)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "%s is too large", what);
    *value = (int64_t)bits;
    return SB_OK;
}

/* A count of things that take at least `bytes` bytes in a binary file, and two per number in a text. */
static sb_result sbi_gmsh_count(sbi_gmsh *gmsh, const char *what, size_t bytes, size_t numbers, int *count)
{
    int64_t value = 0;
    sb_result result = sbi_gmsh_size(gmsh, what, &value);
    return result
               ? result
               : sbi_reader_check_count(gmsh->reader, what, value, gmsh->binary ? bytes : 2 * numbers, count);
}

static sb_result sbi_gmsh_skip_reals(sbi_gmsh *gmsh, size_t count)
{
    if (!gmsh->binary)
        return sbi_reader_skip_words(gmsh->reader, count, "coordinates");
    return sbi_reader_bytes(gmsh->reader, count, 8, "coordinates") ? SB_OK : SB_ERROR_FORMAT;
}

static sb_result sbi_gmsh_node(sbi_gmsh *gmsh)
{
    const unsigned char *bytes;
    double x[3];
    if (!gmsh->binary)
        return sbi_loader_read_node(gmsh->loader);
    gmsh->reader->node = (int)gmsh->loader->node_count;
    bytes = sbi_reader_bytes(gmsh->reader, 3, 8, "coordinates");
    if (!bytes)
        return SB_ERROR_FORMAT;
    for (int i = 0; i < 3; i++)
        x[i] = sbi_decode_float(gmsh->reader, bytes + 8 * i, 8);
    return sbi_loader_add_node(gmsh->loader, x);
}

/* Physical groups become regions; gmsh gives a minus sign to groups of reversed orientation. */
static sb_result sbi_gmsh_region(const sbi_gmsh *gmsh, int64_t physical, int *region)
{
    if (physical > INT_MAX || physical < -INT_MAX)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "physical group %lld is too large",
                               (long long)physical);
    *region = (int)(physical < 0 ? -physical : physical);
    return SB_OK;
}

/* ---- node numbers ---- */

static int sbi_gmsh_tag_before(const void *context, int a, int b)
{
    const int64_t *tags = (const int64_t *)context;
    return tags[a] < tags[b];
}

/* Room for the tags of `count` more nodes and for their coordinates. */
static sb_result sbi_gmsh_reserve_nodes(sbi_gmsh *gmsh, int count)
{
    size_t used = gmsh->loader->node_count, needed = used + (size_t)count;
    if (needed > gmsh->tag_capacity) {
        void *grown =
            sbi_loader_grow(gmsh->loader, gmsh->tags, used, &gmsh->tag_capacity, needed, sizeof(int64_t));
        if (!grown)
            return sbi_loader_no_memory(gmsh->loader);
        gmsh->tags = (int64_t *)grown;
    }
    return sbi_loader_reserve_nodes(gmsh->loader, count);
}

/* Sorts the tags for sbi_gmsh_find_node; two equal ones are an error. */
static sb_result sbi_gmsh_sort_tags(sbi_gmsh *gmsh)
{
    int count = (int)gmsh->loader->node_count;
    const sb_allocator *allocator = &gmsh->loader->allocator;
    int *scratch = (int *)sbi_alloc(allocator, (size_t)count, sizeof(int));
    gmsh->order = (int *)sbi_alloc(allocator, (size_t)count, sizeof(int));
    if (!scratch || !gmsh->order) {
        sbi_free(allocator, scratch);
        return sbi_loader_no_memory(gmsh->loader);
    }
    for (int i = 0; i < count; i++)
        gmsh->order[i] = i;
    sbi_merge_sort(gmsh->order, scratch, count, sbi_gmsh_tag_before, gmsh->tags);
    sbi_free(allocator, scratch);
    for (int i = 1; i < count; i++) {
        if (gmsh->tags[gmsh->order[i]] != gmsh->tags[gmsh->order[i - 1]])
            continue;
        gmsh->reader->node = gmsh->order[i];
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "two nodes have the number %lld",
                               (long long)gmsh->tags[gmsh->order[i]]);
    }
    return SB_OK;
}

/* Node with the tag, or -1. */
static int sbi_gmsh_find_node(const sbi_gmsh *gmsh, int64_t tag)
{
    int low = 0, high = (int)gmsh->loader->node_count - 1;
    int64_t first = gmsh->tags[gmsh->order[0]], last = gmsh->tags[gmsh->order[high]];
    if (tag < first || tag > last)
        return -1;
    if (last - first == high) /* no gaps */
        return gmsh->order[tag - first];
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (gmsh->tags[gmsh->order[middle]] < tag)
            low = middle + 1;
        else
            high = middle;
    }
    return gmsh->tags[gmsh->order[low]] == tag ? gmsh->order[low] : -1;
}

static sb_result sbi_gmsh_cell_node(sbi_gmsh *gmsh, int64_t tag)
{
    int node = sbi_gmsh_find_node(gmsh, tag);
    if (node < 0)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_INDEX,
                               "element %d refers to node number %lld, which does not exist",
                               gmsh->reader->element, (long long)tag);
    return sbi_loader_cell_node(gmsh->loader, node, 0);
}

/* ---- nodes ---- */

static sb_result sbi_gmsh_node_tag(sbi_gmsh *gmsh, int node)
{
    sb_result result;
    gmsh->reader->node = node;
    result = gmsh->version == 2 ? sbi_gmsh_integer(gmsh, "node number", &gmsh->tags[node])
                                : sbi_gmsh_size(gmsh, "node number", &gmsh->tags[node]);
    if (!result && gmsh->tags[node] < 0)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "a negative node number: %lld",
                               (long long)gmsh->tags[node]);
    return result;
}

/* 2.x: count, then per line a number and three coordinates. The count is text also in binary files. */
static sb_result sbi_gmsh_nodes_2(sbi_gmsh *gmsh)
{
    int count = 0;
    sb_result result = sbi_reader_count(gmsh->reader, "the number of nodes", gmsh->binary ? 28 : 8, &count);
    if (!result)
        result = sbi_gmsh_reserve_nodes(gmsh, count);
    if (!result && gmsh->binary)
        sbi_reader_next_line(gmsh->reader);
    for (int i = 0; i < count && !result; i++) {
        result = sbi_gmsh_node_tag(gmsh, i);
        if (!result)
            result = sbi_gmsh_node(gmsh);
    }
    return result;
}

/* One block of 4.1: dimension, tag, parametric, count; the numbers; the coordinates. */
static sb_result sbi_gmsh_node_block(sbi_gmsh *gmsh)
{
    int64_t header[3] = {0, 0, 0};
    int count = 0, first = (int)gmsh->loader->node_count;
    sb_result result = SB_OK;
    for (int i = 0; i < 3 && !result; i++)
        result = sbi_gmsh_integer(gmsh, "header of a block of nodes", &header[i]);
    if (!result && (header[0] < 0 || header[0] > 3))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "an entity of dimension %lld",
                               (long long)header[0]);
    if (!result)
        result =
            sbi_gmsh_count(gmsh, "the number of nodes of a block", (size_t)gmsh->size_bytes + 24, 4, &count);
    if (!result && count > INT_MAX - first)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 nodes");
    if (!result)
        result = sbi_gmsh_reserve_nodes(gmsh, count);
    for (int i = 0; i < count && !result; i++)
        result = sbi_gmsh_node_tag(gmsh, first + i);
    for (int i = 0; i < count && !result; i++) {
        result = sbi_gmsh_node(gmsh);
        if (!result && header[2])
            result = sbi_gmsh_skip_reals(gmsh, (size_t)header[0]); /* parameters on the entity */
    }
    gmsh->reader->node = -1;
    return result;
}

/* 4.1: numbers of blocks and nodes, lowest and highest tag; blocks. */
static sb_result sbi_gmsh_nodes_4(sbi_gmsh *gmsh)
{
    int blocks = 0, count = 0;
    int64_t unused = 0;
    sb_result result =
        sbi_gmsh_count(gmsh, "the number of blocks of nodes", 12 + (size_t)gmsh->size_bytes, 4, &blocks);
    if (!result)
        result = sbi_gmsh_count(gmsh, "the number of nodes", 24 + (size_t)gmsh->size_bytes, 4, &count);
    for (int i = 0; i < 2 && !result; i++)
        result = sbi_gmsh_size(gmsh, "node number", &unused);
    if (!result)
        result = sbi_gmsh_reserve_nodes(gmsh, count);
    for (int i = 0; i < blocks && !result; i++)
        result = sbi_gmsh_node_block(gmsh);
    if (!result && (size_t)count != gmsh->loader->node_count)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "%llu nodes, but %d are announced",
                               (unsigned long long)gmsh->loader->node_count, count);
    return result;
}

static sb_result sbi_gmsh_nodes(sbi_gmsh *gmsh)
{
    sb_result result;
    if (gmsh->has_nodes)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "a second $Nodes section");
    gmsh->has_nodes = 1;
    result = gmsh->version == 2 ? sbi_gmsh_nodes_2(gmsh) : sbi_gmsh_nodes_4(gmsh);
    if (!result && gmsh->loader->node_count == 0)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_MESH, "the file has no nodes");
    return result ? result : sbi_gmsh_sort_tags(gmsh);
}

/* ---- entities (4.1) ---- */

static int sbi_gmsh_compare_entities(const sbi_gmsh_entity *a, int64_t dimension, int64_t tag)
{
    if (a->dimension != dimension)
        return a->dimension < dimension ? -1 : 1;
    return a->tag == tag ? 0 : a->tag < tag ? -1 : 1;
}

static int sbi_gmsh_entity_before(const void *context, int a, int b)
{
    const sbi_gmsh_entity *entities = (const sbi_gmsh_entity *)context;
    return sbi_gmsh_compare_entities(&entities[a], entities[b].dimension, entities[b].tag) < 0;
}

static sb_result sbi_gmsh_add_entity(sbi_gmsh *gmsh, int dimension, int64_t tag, int region)
{
    sbi_gmsh_entity *entity;
    if (gmsh->entity_count == INT_MAX)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 entities");
    if (gmsh->entity_count == gmsh->entity_capacity) {
        void *grown =
            sbi_loader_grow(gmsh->loader, gmsh->entities, gmsh->entity_count, &gmsh->entity_capacity,
                            gmsh->entity_count + 1, sizeof gmsh->entities[0]);
        if (!grown)
            return sbi_loader_no_memory(gmsh->loader);
        gmsh->entities = (sbi_gmsh_entity *)grown;
    }
    entity = &gmsh->entities[gmsh->entity_count++];
    entity->dimension = dimension;
    entity->tag = tag;
    entity->region = region;
    return SB_OK;
}

/* Tag, box (points: place), physical groups, and but for points the entities that bound it. */
static sb_result sbi_gmsh_entity_line(sbi_gmsh *gmsh, int dimension)
{
    int64_t tag = 0, group = 0;
    int groups = 0, bounds = 0, region = 0;
    sb_result result = sbi_gmsh_integer(gmsh, "entity", &tag);
    if (!result)
        result = sbi_gmsh_skip_reals(gmsh, dimension == 0 ? 3 : 6);
    if (!result)
        result = sbi_gmsh_count(gmsh, "the number of physical groups", 4, 1, &groups);
    for (int i = 0; i < groups && !result; i++) {
        result = sbi_gmsh_integer(gmsh, "physical group", &group);
        if (!result && i == 0)
            result = sbi_gmsh_region(gmsh, group, &region);
    }
    if (!result && dimension > 0)
        result = sbi_gmsh_count(gmsh, "the number of bounding entities", 4, 1, &bounds);
    for (int i = 0; i < bounds && !result; i++)
        result = sbi_gmsh_integer(gmsh, "bounding entity", &group);
    return result || groups == 0 ? result : sbi_gmsh_add_entity(gmsh, dimension, tag, region);
}

static sb_result sbi_gmsh_entities(sbi_gmsh *gmsh)
{
    int counts[4] = {0, 0, 0, 0};
    int *scratch;
    sb_result result = SB_OK;
    if (gmsh->entity_order)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "a second $Entities section");
    for (int i = 0; i < 4 && !result; i++)
        result = sbi_gmsh_count(gmsh, "the number of entities", 28, 5, &counts[i]);
    for (int dimension = 0; dimension < 4; dimension++)
        for (int i = 0; i < counts[dimension] && !result; i++)
            result = sbi_gmsh_entity_line(gmsh, dimension);
    if (result)
        return result;
    scratch = (int *)sbi_alloc(&gmsh->loader->allocator, gmsh->entity_count, sizeof(int));
    gmsh->entity_order = (int *)sbi_alloc(&gmsh->loader->allocator, gmsh->entity_count, sizeof(int));
    if (scratch && gmsh->entity_order) {
        for (size_t i = 0; i < gmsh->entity_count; i++)
            gmsh->entity_order[i] = (int)i;
        sbi_merge_sort(gmsh->entity_order, scratch, (int)gmsh->entity_count, sbi_gmsh_entity_before,
                       gmsh->entities);
    } else {
        result = sbi_loader_no_memory(gmsh->loader);
    }
    sbi_free(&gmsh->loader->allocator, scratch);
    return result;
}

/* Region of an entity; 0 when it is in no physical group. */
static int sbi_gmsh_entity_region(const sbi_gmsh *gmsh, int64_t dimension, int64_t tag)
{
    int low = 0, high = (int)gmsh->entity_count;
    while (low < high) {
        int middle = low + (high - low) / 2;
        const sbi_gmsh_entity *entity = &gmsh->entities[gmsh->entity_order[middle]];
        int compared = sbi_gmsh_compare_entities(entity, dimension, tag);
        if (compared == 0)
            return entity->region;
        if (compared < 0)
            low = middle + 1;
        else
            high = middle;
    }
    return 0;
}

/* ---- elements ---- */

static sb_result sbi_gmsh_find_kind(const sbi_gmsh *gmsh, int64_t number, int *kind)
{
    *kind = sbi_cell_kind_of_gmsh(number);
    if (*kind < 0)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED,
                               "element %d has the unknown gmsh type %lld", gmsh->loader->source_count,
                               (long long)number);
    return SB_OK;
}

/* 2.x after the type is known: tags (the first is the physical group), then nodes. */
static sb_result sbi_gmsh_element_2(sbi_gmsh *gmsh, int kind, int tags)
{
    int64_t value = 0;
    int region = 0;
    sb_result result = SB_OK;
    for (int i = 0; i < tags && !result; i++) {
        result = sbi_gmsh_integer(gmsh, "element tag", &value);
        if (!result && i == 0)
            result = sbi_gmsh_region(gmsh, value, &region);
    }
    for (int i = 0; i < sbi_cell_kind_at(kind)->nodes && !result; i++) {
        result = sbi_gmsh_integer(gmsh, "node number", &value);
        if (!result)
            result = sbi_gmsh_cell_node(gmsh, value);
    }
    return result ? result
                  : sbi_loader_end_cell(gmsh->loader, kind, sbi_cell_kind_at(kind)->gmsh_order, region);
}

/* A text line: number, type, number of tags, tags, nodes. */
static sb_result sbi_gmsh_text_element(sbi_gmsh *gmsh)
{
    int64_t number = 0, type = 0;
    int tags = 0, kind = 0;
    sb_result result;
    sbi_loader_begin_cell(gmsh->loader);
    result = sbi_reader_integer(gmsh->reader, "element number", &number);
    if (!result)
        result = sbi_reader_integer(gmsh->reader, "element type", &type);
    if (!result)
        result = sbi_gmsh_find_kind(gmsh, type, &kind);
    if (!result)
        result = sbi_reader_count(gmsh->reader, "the number of tags", 2, &tags);
    return result ? result : sbi_gmsh_element_2(gmsh, kind, tags);
}

/* A binary block of 2.x: type, count, number of tags; elements with number, tags, nodes. At most `left`
 * elements. */
static sb_result sbi_gmsh_binary_block(sbi_gmsh *gmsh, int left, int *count)
{
    int64_t header[3] = {0, 0, 0};
    int tags = 0, kind = 0;
    sb_result result = SB_OK;
    for (int i = 0; i < 3 && !result; i++)
        result = sbi_gmsh_integer(gmsh, "header of a block of elements", &header[i]);
    if (!result)
        result = sbi_gmsh_find_kind(gmsh, header[0], &kind);
    if (!result)
        result =
            sbi_reader_check_count(gmsh->reader, "the number of elements of a block", header[1], 8, count);
    if (!result)
        result = sbi_reader_check_count(gmsh->reader, "the number of tags", header[2], 4, &tags);
    if (!result && (*count > left || *count == 0))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "a block of %d elements where %d are left",
                               *count, left);
    for (int i = 0; i < *count && !result; i++) {
        sbi_loader_begin_cell(gmsh->loader);
        result = sbi_gmsh_integer(gmsh, "element number", &header[0]);
        if (!result)
            result = sbi_gmsh_element_2(gmsh, kind, tags);
    }
    return result;
}

static sb_result sbi_gmsh_elements_2(sbi_gmsh *gmsh)
{
    int count = 0, block = 1;
    sb_result result = sbi_reader_count(gmsh->reader, "the number of elements", 8, &count);
    if (!result && gmsh->binary)
        sbi_reader_next_line(gmsh->reader);
    for (int i = 0; i < count && !result; i += block)
        result = gmsh->binary ? sbi_gmsh_binary_block(gmsh, count - i, &block) : sbi_gmsh_text_element(gmsh);
    return result;
}

/* 4.1: dimension and tag of the entity, type, count; elements with number and nodes. */
static sb_result sbi_gmsh_element_block(sbi_gmsh *gmsh)
{
    int64_t header[3] = {0, 0, 0}, value = 0;
    int count = 0, kind = 0, region, nodes;
    sb_result result = SB_OK;
    for (int i = 0; i < 3 && !result; i++)
        result = sbi_gmsh_integer(gmsh, "header of a block of elements", &header[i]);
    if (!result)
        result = sbi_gmsh_find_kind(gmsh, header[2], &kind);
    if (result)
        return result;
    nodes = sbi_cell_kind_at(kind)->nodes;
    result = sbi_gmsh_count(gmsh, "the number of elements of a block",
                            (size_t)(1 + nodes) * (size_t)gmsh->size_bytes, (size_t)(1 + nodes), &count);
    region = sbi_gmsh_entity_region(gmsh, header[0], header[1]);
    for (int i = 0; i < count && !result; i++) {
        sbi_loader_begin_cell(gmsh->loader);
        result = sbi_gmsh_size(gmsh, "element number", &value);
        for (int k = 0; k < nodes && !result; k++) {
            result = sbi_gmsh_size(gmsh, "node number", &value);
            if (!result)
                result = sbi_gmsh_cell_node(gmsh, value);
        }
        if (!result)
            result = sbi_loader_end_cell(gmsh->loader, kind, sbi_cell_kind_at(kind)->gmsh_order, region);
    }
    return result;
}

static sb_result sbi_gmsh_elements_4(sbi_gmsh *gmsh)
{
    int blocks = 0, count = 0;
    int64_t unused = 0;
    sb_result result =
        sbi_gmsh_count(gmsh, "the number of blocks of elements", 12 + (size_t)gmsh->size_bytes, 4, &blocks);
    if (!result)
        result = sbi_gmsh_count(gmsh, "the number of elements", 2 * (size_t)gmsh->size_bytes, 2, &count);
    for (int i = 0; i < 2 && !result; i++)
        result = sbi_gmsh_size(gmsh, "element number", &unused);
    for (int i = 0; i < blocks && !result; i++)
        result = sbi_gmsh_element_block(gmsh);
    if (!result && count != gmsh->loader->source_count)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "%d elements, but %d are announced",
                               gmsh->loader->source_count, count);
    return result;
}

static sb_result sbi_gmsh_elements(sbi_gmsh *gmsh)
{
    if (!gmsh->has_nodes)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "$Elements before $Nodes");
    if (gmsh->has_elements)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "a second $Elements section");
    gmsh->has_elements = 1;
    return gmsh->version == 2 ? sbi_gmsh_elements_2(gmsh) : sbi_gmsh_elements_4(gmsh);
}

/* ---- file ---- */

static int sbi_gmsh_same_text(const char *text, sbi_word word)
{
    return memcmp(text, word.text, word.length) == 0;
}

/* Steps behind "$End" + name of the section, wherever it is: for sections whose content is of no interest. */
static sb_result sbi_gmsh_skip_section(sbi_gmsh *gmsh, sbi_word name)
{
    sbi_reader *reader = gmsh->reader;
    char text[32];
    for (; sbi_reader_left(reader) >= name.length + 4; reader->at++) {
        const char *here = reader->data + reader->at;
        if (*here == '\n' && reader->line < INT_MAX)
            reader->line++;
        if (*here == '$' && memcmp(here, "$End", 4) == 0 && sbi_gmsh_same_text(here + 4, name)) {
            reader->at += name.length + 4;
            return SB_OK;
        }
    }
    return sbi_reader_fail(reader, SB_ERROR_FORMAT, "$End%s is missing", sbi_word_print(name, text));
}

static sb_result sbi_gmsh_expect_end(sbi_gmsh *gmsh, sbi_word name)
{
    sbi_word word;
    char text[32];
    if (sbi_reader_word(gmsh->reader, &word) && word.length == name.length + 4 &&
        memcmp(word.text, "$End", 4) == 0 && sbi_gmsh_same_text(word.text + 4, name))
        return SB_OK;
    return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "$End%s is missing", sbi_word_print(name, text));
}

/* $MeshFormat: version, 0 text or 1 binary, bytes of a number; in binary files the integer 1, telling byte
 * order. */
static sb_result sbi_gmsh_format(sbi_gmsh *gmsh)
{
    sbi_word version;
    int64_t binary = 0, bytes = 0;
    char text[32];
    const unsigned char *one;
    sb_result result;
    if (gmsh->version)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "a second $MeshFormat section");
    if (!sbi_reader_word(gmsh->reader, &version))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "the version number is missing");
    if (sbi_word_is(version, "4.1"))
        gmsh->version = 4;
    else if (version.length >= 1 && version.text[0] == '2' && (version.length == 1 || version.text[1] == '.'))
        gmsh->version = 2;
    else
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED,
                               "gmsh version %s is not supported: 2.x and 4.1 are",
                               sbi_word_print(version, text));
    result = sbi_reader_integer(gmsh->reader, "file type", &binary);
    if (!result)
        result = sbi_reader_integer(gmsh->reader, "data size", &bytes);
    if (result)
        return result;
    if (binary < 0 || binary > 1 || (bytes != 8 && !(bytes == 4 && gmsh->version == 4)))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED, "file type %lld with data size %lld",
                               (long long)binary, (long long)bytes);
    gmsh->size_bytes = (int)bytes;
    if (!binary)
        return SB_OK;
    sbi_reader_next_line(gmsh->reader);
    gmsh->binary = gmsh->reader->binary = 1;
    one = sbi_reader_bytes(gmsh->reader, 1, 4, "$MeshFormat");
    if (!one)
        return SB_ERROR_FORMAT;
    gmsh->reader->big_endian = one[3] == 1;
    if (sbi_decode_bits(gmsh->reader, one, 4) != 1)
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "the mark of the byte order is not 1");
    return SB_OK;
}

static sb_result sbi_gmsh_section(sbi_gmsh *gmsh, sbi_word keyword)
{
    sbi_word name = keyword;
    char text[32];
    sb_result result;
    int elements = sbi_word_is(keyword, "$Elements"), nodes = sbi_word_is(keyword, "$Nodes");
    int entities = sbi_word_is(keyword, "$Entities"), format = sbi_word_is(keyword, "$MeshFormat");
    if (keyword.length < 2 || keyword.text[0] != '$')
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "'%s' where a section should begin",
                               sbi_word_print(keyword, text));
    name.text++;
    name.length--;
    if (sbi_word_is(keyword, "$NOD"))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED, "gmsh version 1 is not supported");
    if (sbi_word_is(keyword, "$PartitionedEntities"))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_UNSUPPORTED,
                               "partitioned gmsh meshes are not supported");
    if (!gmsh->version && (elements || nodes || entities))
        return sbi_reader_fail(gmsh->reader, SB_ERROR_FORMAT, "$MeshFormat is missing");
    if (!(elements || nodes || format || (entities && gmsh->version == 4)))
        return sbi_gmsh_skip_section(gmsh, name);
    if (gmsh->binary && !(gmsh->version == 2 && (nodes || elements)))
        sbi_reader_next_line(gmsh->reader);
    if (format)
        result = sbi_gmsh_format(gmsh);
    else if (entities)
        result = sbi_gmsh_entities(gmsh);
    else
        result = nodes ? sbi_gmsh_nodes(gmsh) : sbi_gmsh_elements(gmsh);
    return result ? result : sbi_gmsh_expect_end(gmsh, name);
}

SBI_API sb_result sbi_gmsh_read(sbi_loader *loader)
{
    sbi_gmsh gmsh;
    sbi_word keyword;
    sb_result result = SB_OK;
    memset(&gmsh, 0, sizeof gmsh);
    gmsh.loader = loader;
    gmsh.reader = &loader->reader;
    while (!result && sbi_reader_word(gmsh.reader, &keyword))
        result = sbi_gmsh_section(&gmsh, keyword);
    if (!result && !gmsh.version)
        result = sbi_reader_fail(gmsh.reader, SB_ERROR_FORMAT, "the file has no $MeshFormat");
    if (!result && !gmsh.has_elements)
        result = sbi_reader_fail(gmsh.reader, SB_ERROR_FORMAT, "the file ends without %s",
                                 gmsh.has_nodes ? "$Elements" : "$Nodes");
    sbi_free(&loader->allocator, gmsh.tags);
    sbi_free(&loader->allocator, gmsh.order);
    sbi_free(&loader->allocator, gmsh.entities);
    sbi_free(&loader->allocator, gmsh.entity_order);
    return result;
}

/* ==== src/softbody/meshio_tetgen.c ==== */
/* meshio_tetgen: reads TetGen's .node and .ele files. Source of the format: TetGen manual, "File formats". */

#include <limits.h>

/* An optional count at the end of a header line. */
static sb_result sbi_tetgen_optional(sbi_reader *reader, const char *what, int *count)
{
    return sbi_reader_at_line_end(reader) ? SB_OK : sbi_reader_count(reader, what, 0, count);
}

static sb_result sbi_tetgen_end_row(sbi_reader *reader)
{
    sbi_word word;
    char text[32];
    if (!sbi_reader_line_word(reader, &word))
        return SB_OK;
    return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s' where the line should end",
                           sbi_word_print(word, text));
}

static sb_result sbi_tetgen_end_file(sbi_reader *reader)
{
    sbi_word word;
    char text[32];
    if (!sbi_reader_word(reader, &word))
        return SB_OK;
    return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s' behind the last row", sbi_word_print(word, text));
}

/* Points, dimension, attributes per point, boundary markers (0 or 1); then number, x, y, z, attributes,
 * marker. */
SBI_API sb_result sbi_tetgen_read_nodes(sbi_loader *loader, int64_t *base)
{
    sbi_reader *reader = &loader->reader;
    int count = 0, attributes = 0, markers = 0;
    int64_t dimension = 0;
    sb_result result;
    reader->comment = '#';
    result = sbi_reader_count(reader, "the number of points", 8, &count);
    if (!result)
        result = sbi_reader_integer(reader, "dimension", &dimension);
    if (!result && dimension != 3)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "points of dimension %lld",
                               (long long)dimension);
    if (!result)
        result = sbi_tetgen_optional(reader, "the number of attributes", &attributes);
    if (!result)
        result = sbi_tetgen_optional(reader, "the number of markers", &markers);
    if (!result)
        result = sbi_tetgen_end_row(reader);
    if (!result && markers > 1)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "%d boundary markers per point", markers);
    if (!result)
        result = sbi_loader_reserve_nodes(loader, count);
    for (int i = 0; i < count && !result; i++) {
        int64_t number = 0;
        reader->node = i;
        result = sbi_reader_integer(reader, "point number", &number);
        if (i == 0)
            *base = number;
        if (!result && (number != *base + i || *base < 0 || *base > 1))
            return sbi_reader_fail(reader, SB_ERROR_FORMAT,
                                   "point number %lld: points are numbered from 0 or 1 on",
                                   (long long)number);
        if (!result)
            result = sbi_loader_read_node(loader);
        if (!result)
            result = sbi_reader_skip_words(reader, (size_t)attributes + (size_t)markers,
                                           "the attributes of a point");
        if (!result)
            result = sbi_tetgen_end_row(reader);
    }
    reader->node = -1;
    return result ? result : sbi_tetgen_end_file(reader);
}

/* First attribute of a tetrahedron: its region, which TetGen may write as 1 or 1.0. */
static sb_result sbi_tetgen_region(sbi_reader *reader, int *region)
{
    double value = 0;
    sb_result result = sbi_reader_real(reader, "region", &value);
    if (!result && !(value >= INT_MIN && value <= INT_MAX && value == (double)(int)value))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the region is not an integer: %g", value);
    *region = (int)value;
    return result;
}

/* Number of the edge of a straight tet10, in our order, in whose middle the node lies; -1: in none. */
static int sbi_tetgen_edge_of(const sb_vec3 corners[4], sb_vec3 node)
{
    static const int edges[6][2] = {{0, 1}, {1, 2}, {0, 2}, {0, 3}, {1, 3}, {2, 3}};
    for (int edge = 0; edge < 6; edge++) {
        sb_vec3 a = corners[edges[edge][0]], b = corners[edges[edge][1]];
        sb_vec3 middle = sb_v3_madd(a, (sb_real)0.5, sb_v3_sub(b, a));
        /* coordinates in the file may be rounded; no two middles come closer than this for a sound element */
        if (sb_v3_norm(sb_v3_sub(node, middle)) < (sb_real)0.01 * sb_v3_norm(sb_v3_sub(b, a)))
            return edge;
    }
    return -1;
}

/* Brings the nodes of a tet10 into our order. Releases of TetGen differ in theirs, but all put the nodes
 * into the middle of straight edges, so the geometry tells. */
static sb_result sbi_tetgen_sort_tet10(sbi_loader *loader)
{
    sb_vec3 corners[4];
    int sorted[6] = {-1, -1, -1, -1, -1, -1};
    for (int i = 0; i < 4; i++)
        corners[i] = loader->nodes[loader->scratch[i]];
    for (int i = 4; i < 10; i++) {
        int edge = sbi_tetgen_edge_of(corners, loader->nodes[loader->scratch[i]]);
        if (edge < 0 || sorted[edge] >= 0)
            return sbi_reader_fail(&loader->reader, SB_ERROR_MESH,
                                   "the mid-edge nodes of element %d do not lie in the middle of its edges",
                                   loader->reader.element);
        sorted[edge] = loader->scratch[i];
    }
    for (int i = 0; i < 6; i++)
        loader->scratch[4 + i] = sorted[i];
    return SB_OK;
}

static sb_result sbi_tetgen_element(sbi_loader *loader, int corners, int attributes, int64_t base)
{
    sbi_reader *reader = &loader->reader;
    int64_t number = 0;
    int region = 0;
    sb_result result;
    sbi_loader_begin_cell(loader);
    result = sbi_reader_integer(reader, "element number", &number);
    for (int i = 0; i < corners && !result; i++) {
        result = sbi_reader_integer(reader, "point number", &number);
        if (!result)
            result = sbi_loader_cell_node(loader, number, base);
    }
    if (!result && corners == 10)
        result = sbi_tetgen_sort_tet10(loader);
    if (!result && attributes)
        result = sbi_tetgen_region(reader, &region);
    if (!result && attributes)
        result = sbi_reader_skip_words(reader, (size_t)attributes - 1, "the attributes of an element");
    if (!result)
        result = sbi_tetgen_end_row(reader);
    return result ? result
                  : sbi_loader_end_cell(loader, corners == 4 ? SBI_CELL_TET4 : SBI_CELL_TET10, SBI_ORDER_SAME,
                                        region);
}

/* Tetrahedra, nodes of each (4 or 10), attributes of each; then number, nodes, attributes. */
SBI_API sb_result sbi_tetgen_read_elements(sbi_loader *loader, int64_t base)
{
    sbi_reader *reader = &loader->reader;
    int count = 0, attributes = 0;
    int64_t corners = 0;
    sb_result result;
    reader->comment = '#';
    result = sbi_reader_count(reader, "the number of tetrahedra", 10, &count);
    if (!result)
        result = sbi_reader_integer(reader, "the number of nodes of a tetrahedron", &corners);
    if (!result && corners != 4 && corners != 10)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "tetrahedra of %lld nodes", (long long)corners);
    if (!result)
        result = sbi_tetgen_optional(reader, "the number of attributes", &attributes);
    if (!result)
        result = sbi_tetgen_end_row(reader);
    for (int i = 0; i < count && !result; i++)
        result = sbi_tetgen_element(loader, (int)corners, attributes, base);
    reader->element = -1;
    return result ? result : sbi_tetgen_end_file(reader);
}

/* ==== src/softbody/meshio_surface.c ==== */
/* meshio_surface: reads OBJ, STL, PLY and OFF. Sources of the formats: Wavefront "Object Files (.obj)"; 3D
 * Systems "StereoLithography Interface Specification"; G. Turk, "The PLY Polygon File Format"; Geomview
 * manual, "OFF". */

#include <limits.h>
#include <string.h>

/* The next word, which must be the keyword. */
static sb_result sbi_surface_expect(sbi_reader *reader, const char *keyword)
{
    sbi_word word;
    char text[32];
    if (!sbi_reader_word(reader, &word))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends where %s should be", keyword);
    if (!sbi_word_is(word, keyword))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s' instead of %s", sbi_word_print(word, text),
                               keyword);
    return SB_OK;
}

/* ==== OBJ ========================================================================================== */

typedef struct sbi_obj {
    sbi_loader *loader;
    sbi_reader *reader;
    int seen; /* vertices on the lines so far, for relative indices */
} sbi_obj;

/* Reads the numbers of the line; at least `low` and at most `high` of them. The first three go to x. */
static sb_result sbi_obj_numbers(sbi_obj *obj, int low, int high, double x[3])
{
    sbi_reader *reader = obj->reader;
    sb_result result = SB_OK;
    int count = 0;
    for (; !sbi_reader_at_line_end(reader) && !result; count++) {
        double value = 0;
        result = sbi_reader_real(reader, "coordinate", &value);
        if (count < 3)
            x[count] = value;
        if (count == high && !result)
            return sbi_reader_fail(reader, SB_ERROR_FORMAT, "a vertex of more than %d numbers", high);
    }
    if (!result && count < low)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "a vertex of %d numbers", count);
    return result;
}

/* v x y z, then perhaps a weight or a colour. */
static sb_result sbi_obj_vertex(sbi_obj *obj)
{
    double x[3] = {0, 0, 0};
    sb_result result;
    obj->reader->node = (int)obj->loader->node_count;
    result = sbi_obj_numbers(obj, 3, 7, x);
    return result ? result : sbi_loader_add_node(obj->loader, x);
}

/* One corner: v, v/vt, v//vn or v/vt/vn. */
static sb_result sbi_obj_corner(sbi_obj *obj, sbi_word word)
{
    int64_t vertex = 0, other = 0;
    size_t start = 0;
    char text[32];
    for (int part = 0; start <= word.length && part < 4; part++) {
        size_t end = start;
        int parsed;
        while (end < word.length && word.text[end] != '/')
            end++;
        parsed = sbi_parse_integer(word.text + start, end - start, part == 0 ? &vertex : &other);
        if (part == 3 || (parsed <= 0 && !(part == 1 && end == start && end + 1 < word.length)))
            return sbi_reader_fail(obj->reader, SB_ERROR_FORMAT, "'%s' is not a corner of a face",
                                   sbi_word_print(word, text));
        start = end + 1;
    }
    if (vertex == 0)
        return sbi_reader_fail(obj->reader, SB_ERROR_INDEX, "vertex index 0: OBJ counts from 1");
    if (vertex < 0 && vertex < -(int64_t)obj->seen)
        return sbi_reader_fail(obj->reader, SB_ERROR_INDEX, "relative vertex index %lld after %d vertices",
                               (long long)vertex, obj->seen);
    return sbi_loader_cell_node(obj->loader, vertex < 0 ? obj->seen + vertex + 1 : vertex, 1);
}

static sb_result sbi_obj_face(sbi_obj *obj)
{
    sbi_word word;
    sb_result result = SB_OK;
    sbi_loader_begin_cell(obj->loader);
    while (!result && sbi_reader_line_word(obj->reader, &word))
        result = sbi_obj_corner(obj, word);
    return result ? result : sbi_loader_end_polygon(obj->loader, 0);
}

/* One line: vertices count in pass 0, faces in pass 1, since a face may refer to vertices further down. */
static sb_result sbi_obj_line(sbi_obj *obj, int pass)
{
    sbi_word word;
    char text[32];
    if (!sbi_reader_line_word(obj->reader, &word))
        return SB_OK;
    if (word.length == 1 && word.text[0] == 'v') {
        obj->seen++;
        return pass == 0 ? sbi_obj_vertex(obj) : SB_OK;
    }
    if (pass == 1 && word.length == 1 && word.text[0] == 'f')
        return sbi_obj_face(obj);
    for (size_t i = 0; i < word.length && i < 2; i++)
        if (!((word.text[i] >= 'a' && word.text[i] <= 'z') || (word.text[i] >= 'A' && word.text[i] <= 'Z')))
            return sbi_reader_fail(obj->reader, SB_ERROR_FORMAT, "'%s' where an OBJ keyword should be",
                                   sbi_word_print(word, text));
    return SB_OK; /* normals, texture, groups, materials, curves */
}

/* Steps behind the line and, for vertices and faces, the lines it continues on: only there a backslash
 * continues a line, since names may end in one. */
static sb_result sbi_obj_pass(sbi_obj *obj, int pass)
{
    sb_result result = SB_OK;
    obj->seen = 0;
    while (sbi_reader_left(obj->reader) && !result) {
        sbi_word word;
        sbi_reader ahead = *obj->reader;
        ahead.continuation = 0;
        obj->reader->continuation =
            sbi_reader_line_word(&ahead, &word) && (sbi_word_is(word, "v") || sbi_word_is(word, "f"));
        result = sbi_obj_line(obj, pass);
        if (!result && obj->reader->continuation)
            while (!sbi_reader_at_line_end(obj->reader))
                sbi_reader_line_word(obj->reader, &word);
        if (!result)
            sbi_reader_next_line(obj->reader);
    }
    return result;
}

SBI_API sb_result sbi_obj_read(sbi_loader *loader)
{
    sbi_obj obj;
    sb_result result;
    obj.loader = loader;
    obj.reader = &loader->reader;
    obj.reader->comment = '#';
    result = sbi_obj_pass(&obj, 0);
    if (result)
        return result;
    obj.reader->at = 0;
    obj.reader->line = 1;
    return sbi_obj_pass(&obj, 1);
}

/* ==== STL ========================================================================================== */

enum { SBI_STL_HEADER = 84, SBI_STL_FACET = 50 };

static uint64_t sbi_stl_count(const char *data)
{
    sbi_reader reader;
    sbi_reader_init(&reader, data, SBI_STL_HEADER, NULL, NULL);
    return sbi_decode_bits(&reader, (const unsigned char *)data + 80, 4);
}

SBI_API int sbi_stl_is_binary(const char *data, size_t size)
{
    return size >= SBI_STL_HEADER && (uint64_t)(size - SBI_STL_HEADER) == SBI_STL_FACET * sbi_stl_count(data);
}

/* 80 bytes of text, the count; per facet a normal and three corners as floats, and two bytes. */
static sb_result sbi_stl_binary(sbi_loader *loader)
{
    sbi_reader *reader = &loader->reader;
    const unsigned char *facets;
    uint64_t count;
    sb_result result = SB_OK;
    reader->binary = 1;
    if (reader->size < SBI_STL_HEADER)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "neither an ASCII nor a binary STL file");
    count = sbi_stl_count(reader->data);
    reader->at = SBI_STL_HEADER;
    if (!sbi_stl_is_binary(reader->data, reader->size))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT,
                               "the file says %llu facets, but has %llu bytes for them",
                               (unsigned long long)count, (unsigned long long)sbi_reader_left(reader));
    if (count > INT_MAX / 3)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 corners");
    facets = sbi_reader_bytes(reader, (size_t)count, SBI_STL_FACET, "facets");
    result = facets ? sbi_loader_reserve_nodes(loader, (int)count * 3) : SB_ERROR_FORMAT;
    for (size_t i = 0; i < (size_t)count * 3 && !result; i++) {
        const unsigned char *corner = facets + i / 3 * SBI_STL_FACET + 12 + i % 3 * 12;
        double x[3];
        for (int k = 0; k < 3; k++)
            x[k] = sbi_decode_float(reader, corner + 4 * k, 4);
        reader->element = (int)(i / 3);
        result = sbi_loader_add_node(loader, x);
    }
    return result;
}

/* After "facet": normal, loop, three vertices. */
static sb_result sbi_stl_facet(sbi_loader *loader)
{
    sbi_reader *reader = &loader->reader;
    sb_result result = sbi_surface_expect(reader, "normal");
    if (loader->node_count > INT_MAX - 3)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "more than 2147483647 corners");
    reader->element = (int)(loader->node_count / 3);
    if (!result)
        result = sbi_reader_skip_words(reader, 3, "a normal"); /* often not a number; the corners tell it */
    if (!result)
        result = sbi_surface_expect(reader, "outer");
    if (!result)
        result = sbi_surface_expect(reader, "loop");
    for (int i = 0; i < 3 && !result; i++) {
        result = sbi_surface_expect(reader, "vertex");
        if (!result)
            result = sbi_loader_read_node(loader);
    }
    if (!result)
        result = sbi_surface_expect(reader, "endloop");
    if (!result)
        result = sbi_surface_expect(reader, "endfacet");
    reader->element = -1;
    return result;
}

/* "solid" and a name, facets, "endsolid"; perhaps several of them. */
static sb_result sbi_stl_ascii(sbi_loader *loader)
{
    sbi_reader *reader = &loader->reader;
    sbi_word word;
    char text[32];
    int inside = 0;
    sb_result result = SB_OK;
    while (!result && sbi_reader_word(reader, &word)) {
        if (inside && sbi_word_is(word, "facet")) {
            result = sbi_stl_facet(loader);
        } else if (sbi_word_is(word, inside ? "endsolid" : "solid")) {
            inside = !inside;
            sbi_reader_next_line(reader);
        } else {
            return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s' where %s should be",
                                   sbi_word_print(word, text), inside ? "facet or endsolid" : "solid");
        }
    }
    if (!result && inside)
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file ends without endsolid");
    return result;
}

/* Values, so that 0 and -0 are one. */
static int sbi_stl_before(const void *context, int a, int b)
{
    const sb_vec3 *nodes = (const sb_vec3 *)context;
    if (nodes[a].x != nodes[b].x)
        return nodes[a].x < nodes[b].x;
    if (nodes[a].y != nodes[b].y)
        return nodes[a].y < nodes[b].y;
    return nodes[a].z < nodes[b].z;
}

/* Makes corners with equal coordinates one vertex, in the order they are met; vertex[i] is that of corner
 * i. `order` holds the sorted corners and serves as scratch. */
static void sbi_stl_weld(sbi_loader *loader, int *order, int *vertex)
{
    int corners = (int)loader->node_count, first = 0, used = 0;
    for (int i = 0; i < corners; i++) {
        if (i > 0 && sbi_stl_before(loader->nodes, order[i - 1], order[i]))
            first = i;
        vertex[order[i]] = order[first]; /* the sort is stable: the corner met first */
    }
    for (int i = 0; i < corners; i++) {
        if (vertex[i] == i) {
            loader->nodes[used] = loader->nodes[i];
            order[i] = used++;
        }
        vertex[i] = order[vertex[i]];
    }
    loader->node_count = (size_t)used;
    loader->merged_vertices = corners - used;
}

static sb_result sbi_stl_make_cells(sbi_loader *loader, const int *vertex, int facets)
{
    sb_result result = SB_OK;
    for (int i = 0; i < facets && !result; i++) {
        sbi_loader_begin_cell(loader);
        for (int k = 0; k < 3 && !result; k++)
            result = sbi_loader_cell_node(loader, vertex[3 * i + k], 0);
        if (!result)
            result = sbi_loader_end_polygon(loader, 0);
    }
    return result;
}

SBI_API sb_result sbi_stl_read(sbi_loader *loader)
{
    sbi_reader *reader = &loader->reader;
    const sb_allocator *allocator = &loader->allocator;
    sbi_word word;
    int *order, *vertex;
    int corners, binary = sbi_stl_is_binary(reader->data, reader->size);
    sb_result result;
    if (!binary)
        binary = !sbi_reader_peek(reader, &word) || !sbi_word_is(word, "solid");
    result = binary ? sbi_stl_binary(loader) : sbi_stl_ascii(loader);
    if (result)
        return result;
    corners = (int)loader->node_count;
    order = (int *)sbi_alloc(allocator, (size_t)corners, sizeof(int));
    vertex = (int *)sbi_alloc(allocator, (size_t)corners, sizeof(int));
    if (order && vertex) {
        for (int i = 0; i < corners; i++)
            order[i] = i;
        sbi_merge_sort(order, vertex, corners, sbi_stl_before, loader->nodes);
        sbi_stl_weld(loader, order, vertex);
        result = sbi_stl_make_cells(loader, vertex, corners / 3);
    } else {
        result = sbi_loader_no_memory(loader);
    }
    sbi_free(allocator, order);
    sbi_free(allocator, vertex);
    return result;
}

/* ==== PLY ========================================================================================== */

typedef enum sbi_ply_role {
    SBI_PLY_OTHER = 0,
    SBI_PLY_X = 1,      /* y and z follow */
    SBI_PLY_CORNERS = 4 /* the list of a face */
} sbi_ply_role;

/* Class and size of a number: i signed, u unsigned, f floating. */
typedef struct sbi_ply_type {
    char name[2][8];
    char class_;
    int size;
} sbi_ply_type;

typedef struct sbi_ply_property {
    const sbi_ply_type *count; /* of a list; NULL: a single number */
    const sbi_ply_type *type;
    int role;
} sbi_ply_property;

typedef struct sbi_ply_element {
    int64_t rows;
    int is_vertex, is_face;
    size_t first, end; /* its properties */
} sbi_ply_element;

typedef struct sbi_ply {
    sbi_loader *loader;
    sbi_reader *reader;
    int ascii;
    sbi_ply_element *elements;
    size_t element_count, element_capacity;
    sbi_ply_property *properties;
    size_t property_count, property_capacity;
} sbi_ply;

static const sbi_ply_type *sbi_ply_find_type(sbi_word word)
{
    static const sbi_ply_type types[] = {{{"char", "int8"}, 'i', 1},     {{"uchar", "uint8"}, 'u', 1},
                                         {{"short", "int16"}, 'i', 2},   {{"ushort", "uint16"}, 'u', 2},
                                         {{"int", "int32"}, 'i', 4},     {{"uint", "uint32"}, 'u', 4},
                                         {{"float", "float32"}, 'f', 4}, {{"double", "float64"}, 'f', 8}};
    for (size_t i = 0; i < sizeof types / sizeof types[0]; i++)
        if (sbi_word_is(word, types[i].name[0]) || sbi_word_is(word, types[i].name[1]))
            return &types[i];
    return NULL;
}

/* The next word of the header line, which must be there; empty and a failure otherwise. */
static sb_result sbi_ply_word(sbi_ply *ply, sbi_word *word)
{
    word->text = "";
    word->length = 0;
    if (sbi_reader_line_word(ply->reader, word))
        return SB_OK;
    return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "an incomplete line in the PLY header");
}

static sb_result sbi_ply_read_type(sbi_ply *ply, const sbi_ply_type **type)
{
    sbi_word word;
    char text[32];
    sb_result result = sbi_ply_word(ply, &word);
    if (result)
        return result;
    *type = sbi_ply_find_type(word);
    if (!*type)
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "'%s' is not a PLY type",
                               sbi_word_print(word, text));
    return SB_OK;
}

/* element NAME COUNT */
static sb_result sbi_ply_add_element(sbi_ply *ply)
{
    sbi_ply_element *element;
    sbi_word name;
    int64_t rows = 0;
    sb_result result = sbi_ply_word(ply, &name);
    if (!result)
        result = sbi_reader_integer(ply->reader, "the number of rows", &rows);
    if (!result && rows < 0)
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "a negative number of rows: %lld",
                               (long long)rows);
    if (result)
        return result;
    if (ply->element_count == ply->element_capacity) {
        void *grown = sbi_loader_grow(ply->loader, ply->elements, ply->element_count, &ply->element_capacity,
                                      ply->element_count + 1, sizeof ply->elements[0]);
        if (!grown)
            return sbi_loader_no_memory(ply->loader);
        ply->elements = (sbi_ply_element *)grown;
    }
    element = &ply->elements[ply->element_count++];
    element->rows = rows;
    element->is_vertex = sbi_word_is(name, "vertex");
    element->is_face = sbi_word_is(name, "face");
    element->first = element->end = ply->property_count;
    return SB_OK;
}

static int sbi_ply_find_role(const sbi_ply_element *element, const sbi_ply_property *property, sbi_word name)
{
    if (property->count) {
        int is_corners = sbi_word_is(name, "vertex_indices") || sbi_word_is(name, "vertex_index");
        return element->is_face && is_corners ? SBI_PLY_CORNERS : SBI_PLY_OTHER;
    }
    if (!element->is_vertex || name.length != 1 || name.text[0] < 'x' || name.text[0] > 'z')
        return SBI_PLY_OTHER;
    return SBI_PLY_X + (name.text[0] - 'x');
}

/* property TYPE NAME, or property list COUNTTYPE TYPE NAME */
static sb_result sbi_ply_add_property(sbi_ply *ply)
{
    sbi_ply_property property = {NULL, NULL, SBI_PLY_OTHER};
    sbi_word name;
    sbi_reader ahead = *ply->reader;
    sb_result result = SB_OK;
    if (ply->element_count == 0)
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "a property before the first element");
    if (sbi_reader_line_word(&ahead, &name) && sbi_word_is(name, "list")) {
        *ply->reader = ahead;
        result = sbi_ply_read_type(ply, &property.count);
    }
    if (!result)
        result = sbi_ply_read_type(ply, &property.type);
    if (!result)
        result = sbi_ply_word(ply, &name);
    if (!result && property.count && property.count->class_ == 'f')
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "a list whose count is not an integer");
    if (result)
        return result;
    property.role = sbi_ply_find_role(&ply->elements[ply->element_count - 1], &property, name);
    if (ply->property_count == ply->property_capacity) {
        void *grown =
            sbi_loader_grow(ply->loader, ply->properties, ply->property_count, &ply->property_capacity,
                            ply->property_count + 1, sizeof ply->properties[0]);
        if (!grown)
            return sbi_loader_no_memory(ply->loader);
        ply->properties = (sbi_ply_property *)grown;
    }
    ply->properties[ply->property_count++] = property;
    ply->elements[ply->element_count - 1].end = ply->property_count;
    return SB_OK;
}

/* format ascii|binary_little_endian|binary_big_endian 1.0 */
static sb_result sbi_ply_format(sbi_ply *ply, int *binary)
{
    sbi_word word;
    char text[32];
    sb_result result = sbi_ply_word(ply, &word);
    if (result)
        return result;
    ply->ascii = sbi_word_is(word, "ascii");
    ply->reader->big_endian = sbi_word_is(word, "binary_big_endian");
    *binary = !ply->ascii;
    if (*binary && !ply->reader->big_endian && !sbi_word_is(word, "binary_little_endian"))
        return sbi_reader_fail(ply->reader, SB_ERROR_UNSUPPORTED, "PLY format %s",
                               sbi_word_print(word, text));
    return SB_OK;
}

static sb_result sbi_ply_header(sbi_ply *ply)
{
    sbi_word word;
    char text[32];
    int binary = -1;
    sb_result result = sbi_surface_expect(ply->reader, "ply");
    while (!result) {
        sbi_reader_next_line(ply->reader);
        if (!sbi_reader_word(ply->reader, &word))
            return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "the file ends in the PLY header");
        if (sbi_word_is(word, "end_header"))
            break;
        if (sbi_word_is(word, "format"))
            result = sbi_ply_format(ply, &binary);
        else if (sbi_word_is(word, "element"))
            result = sbi_ply_add_element(ply);
        else if (sbi_word_is(word, "property"))
            result = sbi_ply_add_property(ply);
        else if (!sbi_word_is(word, "comment") && !sbi_word_is(word, "obj_info"))
            return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "'%s' in the PLY header",
                                   sbi_word_print(word, text));
    }
    if (!result && binary < 0)
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "the PLY header does not tell the format");
    sbi_reader_next_line(ply->reader);
    ply->reader->binary = binary > 0;
    return result;
}

static sb_result sbi_ply_real(sbi_ply *ply, const sbi_ply_type *type, const char *what, double *value)
{
    const unsigned char *bytes;
    if (ply->ascii)
        return sbi_reader_real(ply->reader, what, value);
    bytes = sbi_reader_bytes(ply->reader, 1, (size_t)type->size, what);
    if (!bytes)
        return SB_ERROR_FORMAT;
    if (type->class_ == 'f')
        *value = sbi_decode_float(ply->reader, bytes, type->size);
    else if (type->class_ == 'i')
        *value = (double)sbi_decode_signed(ply->reader, bytes, type->size);
    else
        *value = (double)sbi_decode_bits(ply->reader, bytes, type->size);
    return SB_OK;
}

static sb_result sbi_ply_integer(sbi_ply *ply, const sbi_ply_type *type, const char *what, int64_t *value)
{
    double real = 0;
    sb_result result;
    if (ply->ascii)
        return sbi_reader_integer(ply->reader, what, value);
    result = sbi_ply_real(ply, type, what, &real);
    if (!result && !(real >= INT_MIN && real <= 4294967295.0 && real == (double)(int64_t)real))
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "%s is not an integer: %g", what, real);
    *value = (int64_t)real;
    return result;
}

/* A list that is not a face's, or a single number that is not a coordinate. */
static sb_result sbi_ply_skip(sbi_ply *ply, const sbi_ply_property *property, int64_t count)
{
    if ((uint64_t)count > sbi_reader_left(ply->reader))
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "the file is too short for a list of %lld",
                               (long long)count);
    if (ply->ascii)
        return sbi_reader_skip_words(ply->reader, (size_t)count, "a PLY row");
    return sbi_reader_bytes(ply->reader, (size_t)count, (size_t)property->type->size, "a PLY row")
               ? SB_OK
               : SB_ERROR_FORMAT;
}

static sb_result sbi_ply_list(sbi_ply *ply, const sbi_ply_property *property)
{
    int64_t count = 0, corner = 0;
    sb_result result = sbi_ply_integer(ply, property->count, "the length of a list", &count);
    if (!result && count < 0)
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "a list of negative length: %lld",
                               (long long)count);
    if (result || property->role != SBI_PLY_CORNERS)
        return result ? result : sbi_ply_skip(ply, property, count);
    sbi_loader_begin_cell(ply->loader);
    for (int64_t i = 0; i < count && !result; i++) {
        result = sbi_ply_integer(ply, property->type, "vertex index", &corner);
        if (!result)
            result = sbi_loader_cell_node(ply->loader, corner, 0);
    }
    return result ? result : sbi_loader_end_polygon(ply->loader, 0);
}

static sb_result sbi_ply_row(sbi_ply *ply, const sbi_ply_element *element)
{
    double x[3] = {0, 0, 0};
    sb_result result = SB_OK;
    for (size_t i = element->first; i < element->end && !result; i++) {
        const sbi_ply_property *property = &ply->properties[i];
        if (property->count)
            result = sbi_ply_list(ply, property);
        else if (property->role == SBI_PLY_OTHER)
            result = sbi_ply_skip(ply, property, 1);
        else
            result = sbi_ply_real(ply, property->type, "coordinate", &x[property->role - SBI_PLY_X]);
    }
    return result || !element->is_vertex ? result : sbi_loader_add_node(ply->loader, x);
}

/* Bytes a row takes at least, and in *roles the roles that its properties have, as bits. */
static size_t sbi_ply_row_bytes(const sbi_ply *ply, const sbi_ply_element *element, unsigned *roles)
{
    size_t bytes = 0;
    *roles = 0;
    for (size_t i = element->first; i < element->end; i++) {
        const sbi_ply_property *property = &ply->properties[i];
        bytes += ply->ascii ? 2 : (size_t)(property->count ? property->count->size : property->type->size);
        *roles |= 1u << property->role;
    }
    return bytes;
}

static sb_result sbi_ply_rows(sbi_ply *ply, const sbi_ply_element *element)
{
    unsigned roles = 0;
    int rows = 0;
    size_t bytes = sbi_ply_row_bytes(ply, element, &roles);
    sb_result result;
    if (element->is_vertex && (roles & 0xEu) != 0xEu)
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "vertices without x, y and z");
    if (element->is_face && !(roles & 1u << SBI_PLY_CORNERS))
        return sbi_reader_fail(ply->reader, SB_ERROR_FORMAT, "faces without vertex_indices");
    if (bytes == 0)
        return SB_OK; /* rows of nothing */
    result = sbi_reader_check_count(ply->reader, "the number of rows", element->rows, bytes, &rows);
    if (!result && element->is_vertex)
        result = sbi_loader_reserve_nodes(ply->loader, rows);
    for (int i = 0; i < rows && !result; i++) {
        ply->reader->node = element->is_vertex ? (int)ply->loader->node_count : -1;
        ply->reader->element = element->is_face ? i : -1;
        result = sbi_ply_row(ply, element);
    }
    ply->reader->node = ply->reader->element = -1;
    return result;
}

SBI_API sb_result sbi_ply_read(sbi_loader *loader)
{
    sbi_ply ply;
    sbi_word word;
    sb_result result;
    memset(&ply, 0, sizeof ply);
    ply.loader = loader;
    ply.reader = &loader->reader;
    result = sbi_ply_header(&ply);
    for (size_t i = 0; i < ply.element_count && !result; i++)
        result = sbi_ply_rows(&ply, &ply.elements[i]);
    if (!result && sbi_reader_word(ply.reader, &word))
        result = sbi_reader_fail(ply.reader, SB_ERROR_FORMAT, "the file goes on behind the last row");
    sbi_free(&loader->allocator, ply.elements);
    sbi_free(&loader->allocator, ply.properties);
    return result;
}

/* ==== OFF ========================================================================================== */

/* [ST][C][N]OFF: texture, colours and normals follow the place of a vertex on its line. *extras: whether
 * they do. */
static sb_result sbi_off_keyword(sbi_reader *reader, int *extras)
{
    static const char prefixes[3][3] = {"ST", "C", "N"};
    sbi_word word, rest;
    char text[32];
    if (!sbi_reader_word(reader, &word))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "the file is empty");
    rest = word;
    for (int i = 0; i < 3; i++) {
        size_t length = strlen(prefixes[i]);
        if (rest.length > length && memcmp(rest.text, prefixes[i], length) == 0) {
            rest.text += length;
            rest.length -= length;
        }
    }
    *extras = rest.length != word.length;
    if (rest.length == 3 && memcmp(rest.text, "OFF", 3) == 0)
        return SB_OK;
    if (word.length > 3 && memcmp(word.text + word.length - 3, "OFF", 3) == 0)
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED,
                               "%s is not supported: OFF of three coordinates is",
                               sbi_word_print(word, text));
    return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s' instead of OFF", sbi_word_print(word, text));
}

/* The rest of the line must be empty, or with `extras` numbers. */
static sb_result sbi_off_end_row(sbi_reader *reader, int extras)
{
    sbi_word word;
    char text[32];
    double value;
    while (sbi_reader_line_word(reader, &word))
        if (!extras || sbi_parse_real(word.text, word.length, &value) == 0)
            return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s' where the line should end",
                                   sbi_word_print(word, text));
    return SB_OK;
}

/* Number of corners, the corners, perhaps a colour. Points and edges are stepped over. */
static sb_result sbi_off_face(sbi_loader *loader)
{
    sbi_reader *reader = &loader->reader;
    int64_t vertex = 0;
    int corners = 0;
    sb_result result;
    sbi_loader_begin_cell(loader);
    result = sbi_reader_count(reader, "the number of corners", 2, &corners);
    for (int i = 0; i < corners && !result; i++) {
        result = sbi_reader_integer(reader, "vertex index", &vertex);
        if (!result)
            result = sbi_loader_cell_node(loader, vertex, 0);
    }
    if (!result)
        result = sbi_off_end_row(reader, 1);
    if (!result && (corners == 1 || corners == 2))
        return sbi_loader_end_cell(loader, sbi_cell_kind_of_vtk(corners == 1 ? 1 : 3), SBI_ORDER_SAME, 0);
    return result ? result : sbi_loader_end_polygon(loader, 0);
}

SBI_API sb_result sbi_off_read(sbi_loader *loader)
{
    sbi_reader *reader = &loader->reader;
    int counts[3] = {0, 0, 0}, extras = 0;
    sbi_word word;
    char text[32];
    sb_result result;
    reader->comment = '#';
    result = sbi_off_keyword(reader, &extras);
    if (!result && sbi_reader_peek(reader, &word) && sbi_word_is(word, "BINARY"))
        return sbi_reader_fail(reader, SB_ERROR_UNSUPPORTED, "binary OFF files are not supported");
    if (!result)
        result = sbi_reader_count(reader, "the number of vertices", 6, &counts[0]);
    if (!result)
        result = sbi_reader_count(reader, "the number of faces", 4, &counts[1]);
    if (!result && !sbi_reader_at_line_end(reader)) /* of no use, and not always there */
        result = sbi_reader_count(reader, "the number of edges", 0, &counts[2]);
    if (!result)
        result = sbi_loader_reserve_nodes(loader, counts[0]);
    for (int i = 0; i < counts[0] && !result; i++) {
        result = sbi_loader_read_node(loader);
        if (!result)
            result = sbi_off_end_row(reader, extras);
    }
    for (int i = 0; i < counts[1] && !result; i++)
        result = sbi_off_face(loader);
    if (!result && sbi_reader_word(reader, &word))
        return sbi_reader_fail(reader, SB_ERROR_FORMAT, "'%s' behind the last face",
                               sbi_word_print(word, text));
    return result;
}

/* ==== src/softbody/material.c ==== */
/* material: constructors, checks, and the evaluation that chooses the model at run time. */

#include <string.h>

/* ---- constants ---- */

SB_API sb_real sb_material_bulk(const sb_material *material)
{
    return material->lambda + 2 * material->mu / 3;
}

SB_API sb_real sb_material_young(const sb_material *material)
{
    sb_real lambda = material->lambda, mu = material->mu;
    return mu * (3 * lambda + 2 * mu) / (lambda + mu);
}

SB_API sb_real sb_material_poisson(const sb_material *material)
{
    return material->lambda / (2 * (material->lambda + material->mu));
}

/* ---- constructors ---- */

static sb_material sbi_material_from_young(sb_material_model model, sb_real young, sb_real poisson,
                                           sb_real density)
{
    sb_material m;
    memset(&m, 0, sizeof m);
    m.model = model;
    m.density = density;
    m.lambda = young * poisson / ((1 + poisson) * (1 - 2 * poisson));
    m.mu = young / (2 * (1 + poisson));
    m.c10 = m.mu / 2;
    m.d1 = 2 / sb_material_bulk(&m);
    return m;
}

SB_API sb_material sb_material_linear(sb_real young, sb_real poisson, sb_real density)
{
    return sbi_material_from_young(SB_LINEAR, young, poisson, density);
}

SB_API sb_material sb_material_corotated(sb_real young, sb_real poisson, sb_real density)
{
    return sbi_material_from_young(SB_COROTATED, young, poisson, density);
}

SB_API sb_material sb_material_corotated_invertible(sb_real young, sb_real poisson, sb_real density)
{
    return sbi_material_from_young(SB_COROTATED_INVERTIBLE, young, poisson, density);
}

SB_API sb_material sb_material_svk(sb_real young, sb_real poisson, sb_real density)
{
    return sbi_material_from_young(SB_SVK, young, poisson, density);
}

SB_API sb_material sb_material_neo_hookean(sb_real young, sb_real poisson, sb_real density)
{
    return sbi_material_from_young(SB_NEO_HOOKEAN, young, poisson, density);
}

SB_API sb_material sb_material_stable_neo_hookean(sb_real young, sb_real poisson, sb_real density)
{
    return sbi_material_from_young(SB_STABLE_NEO_HOOKEAN, young, poisson, density);
}

SB_API sb_material sb_material_neo_hookean_isochoric(sb_real c10, sb_real d1, sb_real density)
{
    sb_material m;
    memset(&m, 0, sizeof m);
    m.model = SB_NEO_HOOKEAN_ISOCHORIC;
    m.density = density;
    m.mu = 2 * c10;
    m.lambda = 2 / d1 - 2 * m.mu / 3;
    m.c10 = c10;
    m.d1 = d1;
    return m;
}

/* ---- check ---- */

static sb_result sbi_material_check_finite(const sb_material *m, sb_error *error)
{
    const char *const names[5] = {"density (kg/m^3)", "lambda (Pa)", "mu (Pa)", "c10 (Pa)", "d1 (1/Pa)"};
    const sb_real values[5] = {m->density, m->lambda, m->mu, m->c10, m->d1};
    int count = m->model == SB_NEO_HOOKEAN_ISOCHORIC ? 5 : 3;
    for (int i = 0; i < count; i++)
        if (!sb_is_finite(values[i]))
            return sbi_fail(error, SB_ERROR_NOT_FINITE,
                            "material %s is %g, not finite (Poisson's ratio must be inside (-1, 0.5))",
                            names[i], (double)values[i]);
    return SB_OK;
}

/* c10, d1 > 0, and the Hooke limit that goes with them (1e-3: hand-written numbers are rounded). */
static sb_result sbi_material_check_isochoric(const sb_material *m, sb_error *error)
{
    sb_real tolerance = (sb_real)1e-3, mu = 2 * m->c10, bulk;
    if (!(m->c10 > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL, "material c10 is %g Pa, must be > 0", (double)m->c10);
    if (!(m->d1 > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL, "material d1 is %g 1/Pa, must be > 0", (double)m->d1);
    bulk = 2 / m->d1;
    if (sb_abs(m->mu - mu) > tolerance * mu)
        return sbi_fail(error, SB_ERROR_MATERIAL, "material mu is %g Pa, but 2 c10 is %g Pa", (double)m->mu,
                        (double)mu);
    if (sb_abs(sb_material_bulk(m) - bulk) > tolerance * bulk)
        return sbi_fail(error, SB_ERROR_MATERIAL, "material lambda + 2 mu/3 is %g Pa, but 2/d1 is %g Pa",
                        (double)sb_material_bulk(m), (double)bulk);
    return SB_OK;
}

/* mu > 0 and bulk > 0 are the same as young > 0 and Poisson's ratio in (-1, 0.5); the message names both
 * views. */
static sb_result sbi_material_check_moduli(const sb_material *m, sb_error *error)
{
    double young = (double)sb_material_young(m), poisson = (double)sb_material_poisson(m);
    if (!(m->mu > 0))
        return sbi_fail(error, SB_ERROR_MATERIAL,
                        "material mu is %g Pa, must be > 0 (Young's modulus %g Pa, Poisson's ratio %g)",
                        (double)m->mu, young, poisson);
    if (!(sb_material_bulk(m) > 0) || !(poisson < 0.5))
        return sbi_fail(
            error, SB_ERROR_MATERIAL,
            "material has Poisson's ratio %g, must be inside (-1, 0.5) (bulk modulus %g Pa, mu %g Pa)",
            poisson, (double)sb_material_bulk(m), (double)m->mu);
    return SB_OK;
}

SB_API sb_result sb_material_check(const sb_material *material, sb_error *error)
{
    sb_result result;
    if (!material)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "material is NULL");
    if ((int)material->model < SB_LINEAR || (int)material->model > SB_STABLE_NEO_HOOKEAN)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "material model %d is unknown", (int)material->model);
    result = sbi_material_check_finite(material, error);
    if (result == SB_OK && !(material->density > 0))
        result = sbi_fail(error, SB_ERROR_MATERIAL, "material density is %g kg/m^3, must be > 0",
                          (double)material->density);
    if (result == SB_OK && material->model == SB_NEO_HOOKEAN_ISOCHORIC)
        result = sbi_material_check_isochoric(material, error);
    if (result == SB_OK)
        result = sbi_material_check_moduli(material, error);
    return result;
}

SB_API int sb_material_allows_inversion(sb_material_model model)
{
    switch (model) {
    case SB_LINEAR:
    case SB_COROTATED:
    case SB_COROTATED_INVERTIBLE:
    case SB_SVK:
    case SB_STABLE_NEO_HOOKEAN: return 1;
    case SB_NEO_HOOKEAN:
    case SB_NEO_HOOKEAN_ISOCHORIC:
    case SB_MOONEY_RIVLIN:
    case SB_REDUCED_POLYNOMIAL: return 0;
    }
    return 0;
}

SB_API int sb_material_is_linear(sb_material_model model) { return model == SB_LINEAR; }

/* ---- evaluation ---- */

static int sbi_material_all_finite(const sb_real *values, int count)
{
    for (int i = 0; i < count; i++)
        if (!sb_is_finite(values[i]))
            return 0;
    return 1;
}

SB_API int sb_material_energy(const sb_material *material, const sb_mat3 *F, sb_quat *rotation, sb_real *W)
{
    sb_quat q = rotation ? *rotation : sb_quat_identity();
    sb_real energy = 0;
    if (!material || !F || !W || !sbi_material_all_finite(F->m[0], 9) ||
        !sbi_material_energy_inline((int)material->model, material, F, &q, &energy) || !sb_is_finite(energy))
        return 0;
    *W = energy;
    if (rotation)
        *rotation = q;
    return 1;
}

SB_API int sb_material_stress(const sb_material *material, const sb_mat3 *F, sb_quat *rotation, sb_mat3 *P)
{
    sb_quat q = rotation ? *rotation : sb_quat_identity();
    sb_mat3 stress;
    if (!material || !F || !P || !sbi_material_all_finite(F->m[0], 9) ||
        !sbi_material_stress_inline((int)material->model, material, F, &q, &stress) ||
        !sbi_material_all_finite(stress.m[0], 9))
        return 0;
    *P = stress;
    if (rotation)
        *rotation = q;
    return 1;
}

SB_API int sb_material_tangent(const sb_material *material, const sb_mat3 *F, sb_quat *rotation,
                               sb_tangent_kind kind, sb_real A[81])
{
    sb_quat q = rotation ? *rotation : sb_quat_identity();
    sb_real tangent[81];
    if (!material || !F || !A || !sbi_material_all_finite(F->m[0], 9) ||
        !sbi_material_tangent_inline((int)material->model, material, F, &q, kind, tangent) ||
        !sbi_material_all_finite(tangent, 81))
        return 0;
    for (int i = 0; i < 81; i++)
        A[i] = tangent[i];
    if (rotation)
        *rotation = q;
    return 1;
}

SB_API sb_mat3 sb_cauchy_stress(sb_mat3 F, sb_mat3 P)
{
    return sb_m3_scale(1 / sb_m3_det(F), sb_m3_mult(P, F));
}

SB_API sb_mat3 sb_material_cauchy_stress(const sb_material *material, sb_mat3 F, sb_mat3 P)
{
    return material->model == SB_LINEAR ? P : sb_cauchy_stress(F, P);
}

SB_API sb_real sb_von_mises(sb_mat3 sigma)
{
    sb_mat3 deviator;
    sb_real largest = 0; /* scaled by, lest squares of large stresses overflow */
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            largest = sb_max(largest, sb_abs(sigma.m[i][j]));
    if (!(largest > 0) || !sb_is_finite(largest))
        return largest;
    sigma = sb_m3_scale(1 / largest, sigma);
    deviator = sbi_material_affine(1, sigma, -sb_m3_trace(sigma) / 3);
    return largest * sb_sqrt((sb_real)1.5 * sb_m3_ddot(deviator, deviator));
}

/* ---- shares ---- */

static void sbi_material_scale_shear(sb_material *m, sb_real factor)
{
    m->mu *= factor;
    m->c10 *= factor;
    m->c01 *= factor;
    m->c20 *= factor;
    m->c30 *= factor;
    m->fibre_stiffness *= factor;
}

SBI_API sb_material sbi_material_share_of(const sb_material *material, sbi_material_share share)
{
    sb_material m = *material;
    if (share == SBI_SHARE_SHEAR) {
        m.lambda = 0;
        m.d1 = SB_REAL_MAX; /* its reciprocal is what counts */
    }
    if (share == SBI_SHARE_VOLUME)
        sbi_material_scale_shear(&m, 0);
    return m;
}

SBI_API sb_material sbi_material_relaxing(const sb_material *material)
{
    sb_material m = *material;
    m.lambda = -2 * m.mu / 3;
    m.d1 = SB_REAL_MAX;
    return m;
}

SBI_API sb_material sbi_material_relaxed(const sb_material *material, sb_real a)
{
    sb_material m = *material;
    sb_real bulk = sb_material_bulk(material);
    sbi_material_scale_shear(&m, a);
    m.lambda = bulk - 2 * m.mu / 3;
    return m;
}

SBI_API sb_real sbi_prony_term(const sb_material *material, int term, sb_real dt, sb_real *decay)
{
    sb_real x = dt / material->prony_tau[term];
    *decay = sb_exp(-x);
    if (x < (sb_real)1e-4) /* where the quotient would cancel */
        return 1 - x / 2 + x * x / 6;
    return (1 - *decay) / x;
}

SBI_API sb_real sbi_prony_factor(const sb_material *material, sb_real dt)
{
    sb_real factor = 1, decay;
    for (int i = 0; i < material->prony_count; i++)
        factor -= material->prony_g[i] * (1 - sbi_prony_term(material, i, dt, &decay));
    return factor;
}

/* ==== src/softbody/sparse.c ==== */
/* sparse: pattern from cells, block products, constraints. */

#include <limits.h>
#include <string.h>

/* ---- pattern ------------------------------------------------------------------------------------------- */

/* The cells as the caller gave them, fixed size or lists. */
typedef struct sbi_sparse_cells {
    int node_count, cell_count, nodes_per_cell;
    const int *start, *nodes;
} sbi_sparse_cells;

/* Scratch: the cells of each node as lists, and the node that last marked a node as its neighbour. */
typedef struct sbi_sparse_scratch {
    size_t *node_start; /* [node_count + 1] */
    int *node_cells;
    int *marker; /* [node_count] */
} sbi_sparse_scratch;

static size_t sbi_sparse_cell_begin(const sbi_sparse_cells *cells, int cell)
{
    return cells->start ? (size_t)cells->start[cell] : (size_t)cell * (size_t)cells->nodes_per_cell;
}

static sb_result sbi_sparse_check(const sbi_sparse_cells *cells, sb_error *error)
{
    if (cells->node_count < 1 || cells->cell_count < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "a matrix needs node_count >= 1 and cell_count >= 0, not %d and %d",
                        cells->node_count, cells->cell_count);
    if (cells->cell_count && (!cells->nodes || (!cells->start && cells->nodes_per_cell < 1)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "cells need node indices and a size");
    if (cells->start && cells->start[0] != 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "cell_start begins with %d, not 0", cells->start[0]);
    for (int c = 0; cells->start && c < cells->cell_count; c++)
        if (cells->start[c + 1] < cells->start[c])
            return sbi_fail_element(error, SB_ERROR_ARGUMENT, c, "cell_start descends after cell %d", c);
    for (int c = 0; c < cells->cell_count; c++)
        for (size_t k = sbi_sparse_cell_begin(cells, c); k < sbi_sparse_cell_begin(cells, c + 1); k++)
            if (cells->nodes[k] < 0 || cells->nodes[k] >= cells->node_count)
                return sbi_fail_element(error, SB_ERROR_INDEX, c, "cell %d names node %d of %d", c,
                                        cells->nodes[k], cells->node_count);
    return SB_OK;
}

/* One allocation: node_start, node_cells, marker. */
static void *sbi_sparse_scratch_create(const sbi_sparse_cells *cells, const sb_allocator *allocator,
                                       sbi_sparse_scratch *scratch)
{
    size_t nodes = (size_t)cells->node_count, entries = sbi_sparse_cell_begin(cells, cells->cell_count),
           bytes = 0;
    char *memory;
    if (!sbi_size_add(&bytes, nodes + 1, sizeof(size_t)) || !sbi_size_add(&bytes, entries, sizeof(int)) ||
        !sbi_size_add(&bytes, nodes, sizeof(int)))
        return NULL;
    memory = (char *)sbi_alloc(allocator, bytes, 1);
    if (!memory)
        return NULL;
    scratch->node_start = (size_t *)(void *)memory;
    scratch->node_cells = (int *)(void *)(memory + (nodes + 1) * sizeof(size_t));
    scratch->marker = scratch->node_cells + entries;
    return memory;
}

/* Counting sort of the (node, cell) pairs by node. */
static void sbi_sparse_list_cells(const sbi_sparse_cells *cells, sbi_sparse_scratch *scratch)
{
    size_t entries = sbi_sparse_cell_begin(cells, cells->cell_count);
    memset(scratch->node_start, 0, ((size_t)cells->node_count + 1) * sizeof(size_t));
    for (size_t k = 0; k < entries; k++)
        scratch->node_start[cells->nodes[k] + 1]++;
    for (int i = 0; i < cells->node_count; i++)
        scratch->node_start[i + 1] += scratch->node_start[i];
    for (int c = cells->cell_count; c-- > 0;)
        for (size_t k = sbi_sparse_cell_begin(cells, c); k < sbi_sparse_cell_begin(cells, c + 1); k++)
            scratch->node_cells[--scratch->node_start[cells->nodes[k] + 1]] = c;
    /* filling moved each end to its beginning: entry i + 1 now holds the start of node i */
    for (int i = 0; i < cells->node_count; i++)
        scratch->node_start[i] = scratch->node_start[i + 1];
    scratch->node_start[cells->node_count] = entries;
}

/* Visits each neighbour of each node once (the node itself too). Without columns: counts into fill[node].
 * With columns: appends i to the row of every neighbour of i; i ascends, so the rows come out sorted, and
 * because the pattern is symmetric they are the rows wanted. */
static size_t sbi_sparse_visit(const sbi_sparse_cells *cells, const sbi_sparse_scratch *scratch, int *fill,
                               int *columns)
{
    size_t total = 0;
    for (int i = 0; i < cells->node_count; i++)
        scratch->marker[i] = -1;
    for (int i = 0; i < cells->node_count; i++) {
        size_t before = total;
        scratch->marker[i] = i;
        if (columns)
            columns[fill[i]++] = i;
        total++;
        for (size_t s = scratch->node_start[i]; s < scratch->node_start[i + 1]; s++) {
            int cell = scratch->node_cells[s];
            for (size_t k = sbi_sparse_cell_begin(cells, cell); k < sbi_sparse_cell_begin(cells, cell + 1);
                 k++) {
                int j = cells->nodes[k];
                if (scratch->marker[j] == i)
                    continue;
                scratch->marker[j] = i;
                if (columns)
                    columns[fill[j]++] = i;
                total++;
            }
        }
        if (!columns && fill)
            fill[i] = (int)(total - before);
    }
    return total;
}

/* Carves the matrix's arrays out of one allocation; blocks first for their alignment. */
static int sbi_sparse_layout(sb_matrix *matrix, size_t rows, size_t blocks)
{
    size_t values = 0, bytes = 64;
    char *base;
    int *ints;
    if (!sbi_size_add(&values, blocks, 9 * sizeof(sb_real)) || !sbi_size_add(&values, 8, sizeof(sb_real)) ||
        !sbi_size_add(&bytes, values, 1) || !sbi_size_add(&bytes, 2 * blocks, sizeof(int)) ||
        !sbi_size_add(&bytes, 2 * rows + 1, sizeof(int)) || !sbi_size_add(&bytes, rows, 1))
        return 0;
    matrix->memory = sbi_alloc(&matrix->allocator, bytes, 1);
    if (!matrix->memory)
        return 0;
    base = (char *)matrix->memory;
    base += (64 - (uintptr_t)base % 64) % 64;
    matrix->blocks = (sb_real(*)[9])(void *)base;
    ints = (int *)(void *)(base + values);
    matrix->columns = ints;
    matrix->transpose = ints + blocks;
    matrix->row_start = ints + 2 * blocks;
    matrix->diagonal = matrix->row_start + rows + 1;
    matrix->fixed = (unsigned char *)(matrix->diagonal + rows);
    memset(matrix->blocks, 0, values);
    memset(matrix->fixed, 0, rows);
    return 1;
}

/* Positions of the diagonal and of the transposed blocks; `next` is scratch [row_count]. Rows ascend, so the
 * entries of row j are met in their own order. */
static void sbi_sparse_link(sb_matrix *matrix, int *next)
{
    memcpy(next, matrix->row_start, (size_t)matrix->row_count * sizeof(int));
    for (int i = 0; i < matrix->row_count; i++)
        for (int q = matrix->row_start[i]; q < matrix->row_start[i + 1]; q++) {
            int j = matrix->columns[q];
            matrix->transpose[q] = next[j]++;
            if (j == i)
                matrix->diagonal[i] = q;
        }
}

static sb_result sbi_sparse_fill(const sbi_sparse_cells *cells, sbi_sparse_scratch *scratch,
                                 sb_matrix *matrix, sb_error *error)
{
    size_t total;
    sbi_sparse_list_cells(cells, scratch);
    total = sbi_sparse_visit(cells, scratch, NULL, NULL);
    if (total > INT_MAX || !sbi_sparse_layout(matrix, (size_t)cells->node_count, total))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a matrix of %d rows", cells->node_count);
    matrix->row_count = cells->node_count;
    matrix->block_count = (int)total;
    matrix->row_start[0] = 0;
    sbi_sparse_visit(cells, scratch, matrix->row_start + 1, NULL);
    for (int i = 0; i < matrix->row_count; i++)
        matrix->row_start[i + 1] += matrix->row_start[i];
    memcpy(matrix->diagonal, matrix->row_start, (size_t)matrix->row_count * sizeof(int));
    sbi_sparse_visit(cells, scratch, matrix->diagonal, matrix->columns);
    sbi_sparse_link(matrix, scratch->marker);
    return SB_OK;
}

SB_API sb_result sb_matrix_create(int node_count, int cell_count, int nodes_per_cell, const int *cell_start,
                                  const int *cells, const sb_allocator *allocator, sb_matrix *matrix,
                                  sb_error *error)
{
    sbi_sparse_cells input;
    sbi_sparse_scratch scratch;
    sb_matrix made;
    void *memory;
    sb_result result;
    if (!matrix)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_matrix_create needs a matrix");
    input.node_count = node_count;
    input.cell_count = cell_count;
    input.nodes_per_cell = nodes_per_cell;
    input.start = cell_start;
    input.nodes = cells;
    result = sbi_sparse_check(&input, error);
    if (result != SB_OK)
        return result;
    memory = sbi_sparse_scratch_create(&input, allocator, &scratch);
    if (!memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the pattern of %d rows", node_count);
    memset(&made, 0, sizeof made);
    if (allocator)
        made.allocator = *allocator;
    result = sbi_sparse_fill(&input, &scratch, &made, error);
    sbi_free(allocator, memory);
    if (result == SB_OK)
        *matrix = made;
    return result;
}

SB_API void sb_matrix_free(sb_matrix *matrix)
{
    if (!matrix)
        return;
    sbi_free(&matrix->allocator, matrix->memory);
    memset(matrix, 0, sizeof *matrix);
}

SB_API void sb_matrix_clear(sb_matrix *matrix)
{
    memset(matrix->blocks, 0, (size_t)matrix->block_count * sizeof matrix->blocks[0]);
    memset(matrix->fixed, 0, (size_t)matrix->row_count);
}

SB_API int sb_matrix_find(const sb_matrix *matrix, int i, int j)
{
    int low, high;
    if (i < 0 || j < 0 || i >= matrix->row_count || j >= matrix->row_count)
        return -1;
    low = matrix->row_start[i];
    high = matrix->row_start[i + 1];
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (matrix->columns[middle] < j)
            low = middle + 1;
        else
            high = middle;
    }
    return low < matrix->row_start[i + 1] && matrix->columns[low] == j ? low : -1;
}

/* ---- products ------------------------------------------------------------------------------------------ */

/* Row i of A times x: nine sums, one per place of the 3x3 blocks, added up at the end. They are independent,
 * so no sum waits for another, and both forms below give the same bits. */
#if SBI_HAS_LANES
/* A block's rows and the vector are read as 4-vectors. The fourth lane belongs to what comes next in memory
 * and is never summed; only the last node has nothing after it (`guard`). Three vector products instead of
 * nine, which compilers do not find by themselves. */
SBI_FORCE_INLINE void sbi_sparse_multiply_row(const sb_matrix *matrix, const sb_real *x, sb_real *y, int i,
                                              int guard)
{
    const int *column = matrix->columns + matrix->row_start[i],
              *end = matrix->columns + matrix->row_start[i + 1];
    const sb_real *block = matrix->blocks[matrix->row_start[i]];
    sbi_lanes s0 = {0, 0, 0, 0}, s1 = s0, s2 = s0;
    for (; column < end; column++, block += 9) {
        const sb_real *from = x + 3 * (size_t)*column;
        sbi_lanes v;
        if (guard) {
            sbi_lanes three = {from[0], from[1], from[2], 0};
            v = three;
        } else {
            v = SBI_LANES_AT(from);
        }
        s0 += SBI_LANES_AT(block) * v;
        s1 += SBI_LANES_AT(block + 3) * v;
        s2 += SBI_LANES_AT(block + 6) * v;
    }
    y[0] = s0[0] + s0[1] + s0[2];
    y[1] = s1[0] + s1[1] + s1[2];
    y[2] = s2[0] + s2[1] + s2[2];
}
#else
SBI_FORCE_INLINE void sbi_sparse_multiply_row(const sb_matrix *matrix, const sb_real *x, sb_real *y, int i,
                                              int guard)
{
    const sb_real *block = matrix->blocks[matrix->row_start[i]];
    sb_real s00 = 0, s01 = 0, s02 = 0, s10 = 0, s11 = 0, s12 = 0, s20 = 0, s21 = 0, s22 = 0;
    (void)guard;
    for (int q = matrix->row_start[i]; q < matrix->row_start[i + 1]; q++, block += 9) {
        const sb_real *from = x + 3 * (size_t)matrix->columns[q];
        sb_real v0 = from[0], v1 = from[1], v2 = from[2];
        s00 += block[0] * v0, s01 += block[1] * v1, s02 += block[2] * v2;
        s10 += block[3] * v0, s11 += block[4] * v1, s12 += block[5] * v2;
        s20 += block[6] * v0, s21 += block[7] * v1, s22 += block[8] * v2;
    }
    y[0] = s00 + s01 + s02;
    y[1] = s10 + s11 + s12;
    y[2] = s20 + s21 + s22;
}
#endif

SBI_API void sbi_matrix_multiply_rows(const sb_matrix *matrix, const sb_real *x, sb_real *y, int first,
                                      int last)
{
    const int *columns = matrix->columns, *row_start = matrix->row_start;
    for (int i = first; i < last; i++) {
        if (columns[row_start[i + 1] - 1] != matrix->row_count - 1)
            sbi_sparse_multiply_row(matrix, x, y + 3 * (size_t)i, i, 0);
        else
            sbi_sparse_multiply_row(matrix, x, y + 3 * (size_t)i, i, 1);
    }
}

typedef struct sbi_sparse_product {
    const sb_matrix *matrix;
    const sb_real *x;
    sb_real *y;
} sbi_sparse_product;

static void sbi_sparse_multiply_task(void *user, int chunk)
{
    const sbi_sparse_product *product = (const sbi_sparse_product *)user;
    int first = chunk * SBI_ROW_CHUNK, rows = product->matrix->row_count;
    int last = rows - first < SBI_ROW_CHUNK ? rows : first + SBI_ROW_CHUNK;
    sbi_matrix_multiply_rows(product->matrix, product->x, product->y, first, last);
}

SB_API void sb_matrix_multiply(const sb_matrix *matrix, const sb_real *x, sb_real *y, const sb_jobs *jobs)
{
    sbi_sparse_product product;
    product.matrix = matrix;
    product.x = x;
    product.y = y;
    sbi_run(jobs, sbi_sparse_multiply_task, &product, sbi_row_chunks(matrix->row_count));
}

SB_API sb_real sb_matrix_asymmetry(const sb_matrix *matrix)
{
    sb_real largest = 0, difference = 0;
    for (int q = 0; q < matrix->block_count; q++) {
        const sb_real *a = matrix->blocks[q], *b = matrix->blocks[matrix->transpose[q]];
        for (int r = 0; r < 3; r++)
            for (int c = 0; c < 3; c++) {
                sb_real gap = a[3 * r + c] - b[3 * c + r];
                sb_real size = a[3 * r + c] < 0 ? -a[3 * r + c] : a[3 * r + c];
                if (!sb_is_finite(size))
                    return size - size;
                gap = gap < 0 ? -gap : gap;
                largest = size > largest ? size : largest;
                difference = gap > difference ? gap : difference;
            }
    }
    return largest > 0 ? difference / largest : 0;
}

/* ---- constraints --------------------------------------------------------------------------------------- */

SB_API sb_real sb_matrix_diagonal_scale(const sb_matrix *matrix, const unsigned char *mask)
{
    double sum = 0;
    int count = 0;
    for (int i = 0; i < matrix->row_count; i++)
        for (int k = 0; k < 3; k++) {
            double d = (double)matrix->blocks[matrix->diagonal[i]][4 * k];
            if (mask && mask[i] >> k & 1)
                continue;
            sum += d < 0 ? -d : d;
            count++;
        }
    return sum == 0 ? (sb_real)1 : (sb_real)(sum / count);
}

/* Moves the known terms of node i's prescribed components to the other rows' right-hand sides. The column of
 * component c in block (j, i) is row c of block (i, j). */
static void sbi_sparse_move_known(const sb_matrix *matrix, int i, int mask, const sb_real *value,
                                  sb_real *rhs)
{
    for (int q = matrix->row_start[i]; q < matrix->row_start[i + 1]; q++) {
        const sb_real *block = matrix->blocks[q];
        sb_real *to = rhs + 3 * (size_t)matrix->columns[q];
        for (int c = 0; c < 3; c++)
            if (mask >> c & 1)
                for (int r = 0; r < 3; r++)
                    to[r] -= block[3 * c + r] * value[c];
    }
}

/* Zeroes node i's prescribed rows and columns. */
static void sbi_sparse_zero(sb_matrix *matrix, int i, int mask)
{
    for (int q = matrix->row_start[i]; q < matrix->row_start[i + 1]; q++) {
        sb_real *block = matrix->blocks[q];
        sb_real *transposed = matrix->blocks[matrix->transpose[q]];
        for (int c = 0; c < 3; c++)
            if (mask >> c & 1)
                for (int r = 0; r < 3; r++) {
                    block[3 * c + r] = 0;
                    transposed[3 * r + c] = 0;
                }
    }
}

SB_API void sb_matrix_constrain(sb_matrix *matrix, const unsigned char *mask, const sb_real *values,
                                sb_real *rhs)
{
    sb_real scale = sb_matrix_diagonal_scale(matrix, mask);
    if (values && rhs)
        for (int i = 0; i < matrix->row_count; i++)
            if (mask[i] & SB_XYZ)
                sbi_sparse_move_known(matrix, i, mask[i], values + 3 * (size_t)i, rhs);
    for (int i = 0; i < matrix->row_count; i++) {
        matrix->fixed[i] = (unsigned char)(mask[i] & SB_XYZ);
        if (!matrix->fixed[i])
            continue;
        sbi_sparse_zero(matrix, i, mask[i]);
        for (int k = 0; k < 3; k++)
            if (mask[i] >> k & 1) {
                matrix->blocks[matrix->diagonal[i]][4 * k] = scale;
                if (rhs)
                    rhs[3 * (size_t)i + (size_t)k] = values ? scale * values[3 * (size_t)i + (size_t)k] : 0;
            }
    }
}

/* ==== src/softbody/precond.c ==== */
/* precond: factors and the coarse space of rigid pieces. */

#include <float.h>
#include <limits.h>
#include <math.h>
#include <string.h>

/* ---- four floats ------------------------------------------------------------------------------------------
 * Blocks are stored as three rows of four floats, the fourth unused (0), so that a row is one vector. The
 * compiler's own vectors where it has them, else plain code with the same roundings. */

#if defined(__GNUC__) && !defined(SB_NO_VECTORS)
#define SBI_HAS_FLOAT4 1
typedef float sbi_float4 __attribute__((vector_size(16), may_alias));
#define SBI_F4(v, k) ((v)[k])
#else
#define SBI_HAS_FLOAT4 0
typedef struct sbi_float4 {
    float lane[4];
} sbi_float4;
#define SBI_F4(v, k) ((v).lane[k])
#endif

SBI_FORCE_INLINE sbi_float4 sbi_f4_make(float a, float b, float c)
{
#if SBI_HAS_FLOAT4
    sbi_float4 v = {a, b, c, 0};
#else
    sbi_float4 v = {{a, b, c, 0}};
#endif
    return v;
}

SBI_FORCE_INLINE sbi_float4 sbi_f4_load(const float *from) { return *(const sbi_float4 *)(const void *)from; }
SBI_FORCE_INLINE void sbi_f4_store(float *to, sbi_float4 v) { *(sbi_float4 *)(void *)to = v; }

SBI_FORCE_INLINE sbi_float4 sbi_f4_add(sbi_float4 a, sbi_float4 b)
{
#if SBI_HAS_FLOAT4
    return a + b;
#else
    for (int k = 0; k < 4; k++)
        a.lane[k] += b.lane[k];
    return a;
#endif
}

SBI_FORCE_INLINE sbi_float4 sbi_f4_sub(sbi_float4 a, sbi_float4 b)
{
#if SBI_HAS_FLOAT4
    return a - b;
#else
    for (int k = 0; k < 4; k++)
        a.lane[k] -= b.lane[k];
    return a;
#endif
}

SBI_FORCE_INLINE sbi_float4 sbi_f4_mul(sbi_float4 a, sbi_float4 b)
{
#if SBI_HAS_FLOAT4
    return a * b;
#else
    for (int k = 0; k < 4; k++)
        a.lane[k] *= b.lane[k];
    return a;
#endif
}

SBI_FORCE_INLINE sbi_float4 sbi_f4_scale(float s, sbi_float4 a)
{
#if SBI_HAS_FLOAT4
    return a * s;
#else
    for (int k = 0; k < 4; k++)
        a.lane[k] *= s;
    return a;
#endif
}

/* a[0] m.row0 + a[1] m.row1 + a[2] m.row2 = m^T a */
SBI_FORCE_INLINE sbi_float4 sbi_f4_rows(sbi_float4 a, const float *m)
{
    return sbi_f4_add(sbi_f4_add(sbi_f4_scale(SBI_F4(a, 0), sbi_f4_load(m)),
                                 sbi_f4_scale(SBI_F4(a, 1), sbi_f4_load(m + 4))),
                      sbi_f4_scale(SBI_F4(a, 2), sbi_f4_load(m + 8)));
}

SBI_FORCE_INLINE float sbi_f4_sum(sbi_float4 a) { return SBI_F4(a, 0) + SBI_F4(a, 1) + SBI_F4(a, 2); }

/* Row of three reals, rounded after scaling. sbi_f4_round_row may read a fourth and leave anything in that
 * lane: for rows of matrix blocks, whose fourth lane never reaches a result. */
SBI_FORCE_INLINE sbi_float4 sbi_f4_round(const sb_real *from, sb_real scale)
{
    return sbi_f4_make((float)(from[0] * scale), (float)(from[1] * scale), (float)(from[2] * scale));
}

SBI_FORCE_INLINE sbi_float4 sbi_f4_round_row(const sb_real *from, sb_real scale)
{
#if SBI_HAS_LANES && SB_REAL_IS_FLOAT
    return SBI_LANES_AT(from) * scale;
#elif SBI_HAS_LANES && (defined(__clang__) || __GNUC__ >= 9)
    return __builtin_convertvector(SBI_LANES_AT(from) * scale, sbi_float4);
#else
    return sbi_f4_round(from, scale);
#endif
}

/* ---- the object ---------------------------------------------------------------------------------------- */

enum {
    SBI_PRECOND_MAX_ARRAYS = 32,
    SBI_PRECOND_MAX_ATTEMPTS = 18,
    SBI_PRECOND_MAX_SHIFT = 64, /* beyond a row's length the shifted matrix is dominated by its diagonal, so that the
                                 * factor of any positive definite one exists */
    SBI_PRECOND_RELAX_FIRST = 16,  /* successful updates before a shift is halved on trial */
    SBI_PRECOND_RELAX_LAST = 1024, /* the wait doubles with every failed trial up to this */
    SBI_PRECOND_NODES_PER_PIECE = 85,
    SBI_PRECOND_MAX_PIECES = 64
};

/* The pieces' motions. Piece a has the 6 coarse unknowns 6a .. 6a+5: a translation and a rotation about its
 * centre, in units of its radius, so that both have the size of a displacement. (A Z) is stored by piece:
 * entry e couples piece a (piece_entry[a] <= e < piece_entry[a + 1]) with node entry_node[e], one of its own
 * or next to it. */
typedef struct sbi_precond_coarse {
    int piece_count, size; /* size = 6 piece_count */
    int *piece_start;      /* [piece_count + 1] into piece_nodes */
    int *piece_nodes;      /* [row_count] nodes by piece */
    int *piece_of;         /* [row_count] */
    int *piece_entry;      /* [piece_count + 1] */
    int *entry_node;       /* [entries] */
    int *entry_start;      /* [entries + 1] into entry_blocks */
    int *entry_blocks;     /* [block_count] matrix blocks (node, j) with j in the piece */
    sb_real *places;       /* [row_count][4] position relative to the piece's centre over its radius */
    float *arms;           /* [row_count][4] the same, rounded */
    float *free;           /* [row_count][4] 1 for free components, 0 for prescribed ones */
    float *coupling;       /* [entries][6][4] rows x, y, z of A Z: translations, then rotations */
    double *matrix;        /* [size][size] upper triangle: Z^T A Z, then its Cholesky factor */
    double *inverse;       /* [size] inverse pivots, 0 for motions that the pieces do not have */
    double *solution;      /* [size] */
    sb_vec3 *positions;    /* [row_count] as last given */
} sbi_precond_coarse;

struct sb_preconditioner {
    sb_allocator allocator;
    sb_precond_kind kind;
    int row_count, block_count, lower_count;
    double matrix_scale; /* power of two that brings the mean diagonal near 1 */
    /* lower triangle by rows */
    int *start;     /* [row_count + 1] */
    int *columns;   /* [lower_count] node j < i */
    int *source;    /* [lower_count] matrix block (j, i) */
    float *lower;   /* [lower_count][12] L of M = (I + L) D (I + L)^T */
    float *inverse; /* [row_count][12] D^-1 */
    float *middle;  /* [row_count][4] (I + L)^-1 r */
    float *result;  /* [row_count][4] z, scaled */
    /* IC0: for each block (i, j) the pairs (i, m), (j, m) with m < j: place in row i, index of the block (j,
     * m) */
    size_t *pair_start; /* [lower_count + 1] */
    int *pairs;         /* [pairs][2] */
    float *row;         /* [longest row][12] transposed blocks of the row at work */
    int attempts, successes, wait;
    double shift;
    sbi_precond_coarse coarse;
    size_t bytes;
    int array_count;
    void *arrays[SBI_PRECOND_MAX_ARRAYS];
};

/* An array of the object on a cache line boundary; NULL when there is no memory. */
static void *sbi_precond_take(sb_preconditioner *p, size_t count, size_t size)
{
    size_t bytes = 64;
    void *raw;
    if (!sbi_size_add(&bytes, count, size))
        return NULL;
    raw = sbi_alloc(&p->allocator, bytes, 1);
    if (!raw)
        return NULL;
    p->arrays[p->array_count++] = raw;
    p->bytes += bytes;
    return (char *)raw + (64 - (uintptr_t)raw % 64) % 64;
}

static int *sbi_precond_take_ints(sb_preconditioner *p, size_t count)
{
    return (int *)sbi_precond_take(p, count, sizeof(int));
}

static float *sbi_precond_take_floats(sb_preconditioner *p, size_t count, size_t width)
{
    return (float *)sbi_precond_take(p, count, width * sizeof(float));
}

SB_API void sb_preconditioner_free(sb_preconditioner *preconditioner)
{
    sb_allocator allocator;
    if (!preconditioner)
        return;
    allocator = preconditioner->allocator;
    for (int k = 0; k < preconditioner->array_count; k++)
        sbi_free(&allocator, preconditioner->arrays[k]);
    sbi_free(&allocator, preconditioner);
}

/* ---- the lower triangle -------------------------------------------------------------------------------- */

static int sbi_precond_make_lower(sb_preconditioner *p, const sb_matrix *a)
{
    size_t rows = (size_t)p->row_count, lower = (size_t)p->lower_count;
    p->start = sbi_precond_take_ints(p, rows + 1);
    p->columns = sbi_precond_take_ints(p, lower);
    p->source = sbi_precond_take_ints(p, lower);
    p->lower = sbi_precond_take_floats(p, lower, 12);
    if (!p->start || !p->columns || !p->source || !p->lower)
        return 0;
    p->start[0] = 0;
    for (int i = 0, e = 0; i < p->row_count; i++) {
        for (int q = a->row_start[i]; q < a->diagonal[i]; q++, e++) {
            p->columns[e] = a->columns[q];
            p->source[e] = a->transpose[q];
        }
        p->start[i + 1] = e;
    }
    return 1;
}

/* Walks all pairs of the factorisation; counts them, and writes them when `pairs` is not NULL. place
 * [row_count] is scratch of -1. */
static size_t sbi_precond_list_pairs(const sb_preconditioner *p, int *place, size_t *pair_start, int *pairs)
{
    size_t total = 0;
    for (int i = 0; i < p->row_count; i++) {
        for (int e = p->start[i]; e < p->start[i + 1]; e++) {
            int j = p->columns[e];
            if (pairs)
                pair_start[e] = total;
            /* columns ascend, so place[] holds the m < j of row i when (i, j) is met */
            for (int b = p->start[j]; b < p->start[j + 1]; b++) {
                if (place[p->columns[b]] < 0)
                    continue;
                if (pairs) {
                    pairs[2 * total] = place[p->columns[b]];
                    pairs[2 * total + 1] = b;
                }
                total++;
            }
            place[j] = e - p->start[i];
        }
        for (int e = p->start[i]; e < p->start[i + 1]; e++)
            place[p->columns[e]] = -1;
    }
    if (pairs)
        pair_start[p->lower_count] = total;
    return total;
}

static int sbi_precond_make_pairs(sb_preconditioner *p)
{
    int *place = (int *)sbi_alloc(&p->allocator, (size_t)p->row_count, sizeof(int)), longest = 0;
    size_t total;
    if (!place)
        return 0;
    for (int i = 0; i < p->row_count; i++) {
        place[i] = -1;
        longest = p->start[i + 1] - p->start[i] > longest ? p->start[i + 1] - p->start[i] : longest;
    }
    total = sbi_precond_list_pairs(p, place, NULL, NULL);
    p->pair_start = (size_t *)sbi_precond_take(p, (size_t)p->lower_count + 1, sizeof(size_t));
    p->pairs = (int *)sbi_precond_take(p, total, 2 * sizeof(int));
    p->row = sbi_precond_take_floats(p, (size_t)longest, 12);
    if (p->pair_start && p->pairs && p->row)
        sbi_precond_list_pairs(p, place, p->pair_start, p->pairs);
    sbi_free(&p->allocator, place);
    return p->pair_start && p->pairs && p->row;
}

/* ---- factorisations ------------------------------------------------------------------------------------ */

/* Inverse of a symmetric 3x3 matrix (row-major with rows of 4) when its pivots exceed `least`[k]; else 0. */
static int sbi_precond_invert(const sbi_float4 *d, const float *least, float *inverse)
{
    double a00 = (double)SBI_F4(d[0], 0), a01 = (double)SBI_F4(d[0], 1), a02 = (double)SBI_F4(d[0], 2);
    double a11 = (double)SBI_F4(d[1], 1), a12 = (double)SBI_F4(d[1], 2), a22 = (double)SBI_F4(d[2], 2);
    double c00 = a11 * a22 - a12 * a12, c01 = a02 * a12 - a01 * a22, c02 = a01 * a12 - a02 * a11;
    double minor = a00 * a11 - a01 * a01, det = a00 * c00 + a01 * c01 + a02 * c02, f;
    /* pivots of the elimination: a00, minor / a00, det / minor; comparisons are false for NaN */
    if (!(a00 > (double)least[0] && minor > (double)least[1] * a00 && det > (double)least[2] * minor))
        return 0;
    f = 1 / det;
    sbi_f4_store(inverse, sbi_f4_make((float)(c00 * f), (float)(c01 * f), (float)(c02 * f)));
    sbi_f4_store(inverse + 4, sbi_f4_make((float)(c01 * f), (float)((a00 * a22 - a02 * a02) * f),
                                          (float)((a01 * a02 - a00 * a12) * f)));
    sbi_f4_store(inverse + 8,
                 sbi_f4_make((float)(c02 * f), (float)((a01 * a02 - a00 * a12) * f), (float)(minor * f)));
    return 1;
}

/* Diagonal block i times `factor` in d; smallest pivots that still mean something in `least`. */
SBI_FORCE_INLINE void sbi_precond_diagonal(const sb_preconditioner *p, const sb_matrix *a, int i,
                                           double factor, sbi_float4 *d, float *least)
{
    const sb_real *block = a->blocks[a->diagonal[i]];
    for (int r = 0; r < 3; r++) {
        float diagonal = (float)((double)block[4 * r] * p->matrix_scale * factor);
        d[r] = sbi_f4_round_row(block + 3 * r, (sb_real)p->matrix_scale);
        SBI_F4(d[r], r) = diagonal;
        least[r] = diagonal > 0 ? 64 * FLT_EPSILON * diagonal : 0;
    }
}

/* Node whose diagonal block is not positive definite, or -1. */
static int sbi_precond_invert_diagonals(sb_preconditioner *p, const sb_matrix *a)
{
    for (int i = 0; i < p->row_count; i++) {
        sbi_float4 d[3];
        float least[3];
        sbi_precond_diagonal(p, a, i, 1, d, least);
        if (!sbi_precond_invert(d, least, p->inverse + 12 * (size_t)i))
            return i;
    }
    return -1;
}

/* SSOR: M = (D + w L_A) D^-1 (D + w L_A)^T up to a factor, hence L = w L_A D^-1. */
static void sbi_precond_fill_ssor(sb_preconditioner *p, const sb_matrix *a)
{
    const sb_real relaxation = (sb_real)1.3; /* flat optimum: 1.0 to 1.6 differ by a few iterations */
    sb_real scale = (sb_real)p->matrix_scale * relaxation;
    for (int e = 0; e < p->lower_count; e++) {
        const sb_real *upper = a->blocks[p->source[e]]; /* (j, i): its columns are the rows of (i, j) */
        const float *inverse = p->inverse + 12 * (size_t)p->columns[e];
        sbi_float4 u0 = sbi_f4_round_row(upper, scale), u1 = sbi_f4_round_row(upper + 3, scale);
        sbi_float4 u2 = sbi_f4_round_row(upper + 6, scale);
        float *out = p->lower + 12 * (size_t)e;
        for (int r = 0; r < 3; r++)
            sbi_f4_store(out + 4 * r,
                         sbi_f4_rows(sbi_f4_make(SBI_F4(u0, r), SBI_F4(u1, r), SBI_F4(u2, r)), inverse));
    }
}

/* Block e = (i, j) of row i, whose transposed unscaled blocks are in `row` as U_im = L_im D_m:
 * U_ij = A_ij - sum_m U_im L_jm^T, L_ij = U_ij D_j^-1, D_i -= L_ij U_ij^T. */
SBI_FORCE_INLINE void sbi_precond_eliminate(sb_preconditioner *p, const sb_matrix *a, int e, float *out_row,
                                            sbi_float4 *d)
{
    const sb_real *upper = a->blocks[p->source[e]];
    sb_real scale = (sb_real)p->matrix_scale;
    sbi_float4 u0 = sbi_f4_round_row(upper, scale), u1 = sbi_f4_round_row(upper + 3, scale);
    sbi_float4 u2 = sbi_f4_round_row(upper + 6, scale);
    const float *inverse = p->inverse + 12 * (size_t)p->columns[e];
    float *l = p->lower + 12 * (size_t)e;
    for (size_t k = p->pair_start[e]; k < p->pair_start[e + 1]; k++) {
        const float *ut = p->row + 12 * (size_t)p->pairs[2 * k],
                    *b = p->lower + 12 * (size_t)p->pairs[2 * k + 1];
        u0 = sbi_f4_sub(u0, sbi_f4_rows(sbi_f4_load(b), ut));
        u1 = sbi_f4_sub(u1, sbi_f4_rows(sbi_f4_load(b + 4), ut));
        u2 = sbi_f4_sub(u2, sbi_f4_rows(sbi_f4_load(b + 8), ut));
    }
    sbi_f4_store(out_row, u0);
    sbi_f4_store(out_row + 4, u1);
    sbi_f4_store(out_row + 8, u2);
    for (int r = 0; r < 3; r++) {
        sbi_float4 row = sbi_f4_rows(sbi_f4_make(SBI_F4(u0, r), SBI_F4(u1, r), SBI_F4(u2, r)), inverse);
        sbi_f4_store(l + 4 * r, row);
        d[r] = sbi_f4_sub(d[r], sbi_f4_rows(row, out_row));
    }
}

/* Block IC(0) of A with its diagonal times 1 + shift: node of the first bad pivot, or -1. */
static int sbi_precond_factor(sb_preconditioner *p, const sb_matrix *a, double shift)
{
    for (int i = 0; i < p->row_count; i++) {
        sbi_float4 d[3];
        float least[3];
        sbi_precond_diagonal(p, a, i, 1 + shift, d, least);
        for (int e = p->start[i]; e < p->start[i + 1]; e++)
            sbi_precond_eliminate(p, a, e, p->row + 12 * (size_t)(e - p->start[i]), d);
        if (!sbi_precond_invert(d, least, p->inverse + 12 * (size_t)i))
            return i;
    }
    return -1;
}

/* Shifts: 0, 0.001, 0.002 ... */
static double sbi_precond_lower_shift(double shift) { return shift > 1.5e-3 ? shift / 2 : 0; }

static sb_result sbi_precond_update_ic0(sb_preconditioner *p, const sb_matrix *a, sb_error *error)
{
    int relaxing = p->shift > 0 && p->successes >= p->wait, bad = 0;
    double shift = relaxing ? sbi_precond_lower_shift(p->shift) : p->shift;
    for (p->attempts = 1; p->attempts <= SBI_PRECOND_MAX_ATTEMPTS; p->attempts++) {
        bad = sbi_precond_factor(p, a, shift);
        if (bad < 0 || shift > (double)SBI_PRECOND_MAX_SHIFT)
            break;
        shift = shift * 2 > 1e-3 ? shift * 2 : 1e-3;
    }
    if (bad >= 0) {
        p->shift = 0; /* the next matrix may be a tamer one */
        return sbi_fail_node(error, SB_ERROR_INDEFINITE, bad, "node %d: no incomplete factor up to a shift of %g", bad,
                             shift);
    }
    if (p->attempts > 1) {
        p->wait = relaxing && p->wait < SBI_PRECOND_RELAX_LAST ? 2 * p->wait : p->wait;
        p->successes = 0;
    } else {
        p->successes = relaxing ? 0 : p->successes + (p->successes < INT_MAX);
    }
    p->shift = shift;
    return SB_OK;
}

/* ---- pieces -------------------------------------------------------------------------------------------- */

SBI_FORCE_INLINE sb_real sbi_precond_coordinate(const sb_vec3 *positions, int node, int axis)
{
    return axis == 0 ? positions[node].x : axis == 1 ? positions[node].y : positions[node].z;
}

/* Order along an axis; ties by index, so that the cut is the same everywhere. */
static int sbi_precond_before(const sb_vec3 *positions, int axis, int a, int b)
{
    sb_real xa = sbi_precond_coordinate(positions, a, axis), xb = sbi_precond_coordinate(positions, b, axis);
    return xa < xb || (xa == xb && a < b);
}

static void sbi_precond_sift(const sb_vec3 *positions, int axis, int *nodes, int root, int count)
{
    int node = nodes[root];
    for (int child = 2 * root + 1; child < count; child = 2 * root + 1) {
        if (child + 1 < count && sbi_precond_before(positions, axis, nodes[child], nodes[child + 1]))
            child++;
        if (!sbi_precond_before(positions, axis, node, nodes[child]))
            break;
        nodes[root] = nodes[child];
        root = child;
    }
    nodes[root] = node;
}

static void sbi_precond_sort_nodes(const sb_vec3 *positions, int axis, int *nodes, int count)
{
    for (int root = count / 2; root-- > 0;)
        sbi_precond_sift(positions, axis, nodes, root, count);
    for (int last = count - 1; last > 0; last--) {
        int top = nodes[0];
        nodes[0] = nodes[last];
        nodes[last] = top;
        sbi_precond_sift(positions, axis, nodes, 0, last);
    }
}

static int sbi_precond_longest_axis(const sb_vec3 *positions, const int *nodes, int count)
{
    sb_real extent[3];
    for (int axis = 0; axis < 3; axis++) {
        sb_real low = sbi_precond_coordinate(positions, nodes[0], axis), high = low;
        for (int k = 1; k < count; k++) {
            sb_real x = sbi_precond_coordinate(positions, nodes[k], axis);
            low = x < low ? x : low;
            high = x > high ? x : high;
        }
        extent[axis] = high - low;
    }
    return extent[1] > extent[0] ? (extent[2] > extent[1] ? 2 : 1) : (extent[2] > extent[0] ? 2 : 0);
}

/* Cuts nodes[begin, end) into `pieces` parts of equal size by halving across the longest side; returns the
 * number of the next piece. */
static int sbi_precond_cut(sbi_precond_coarse *c, int begin, int end, int pieces, int piece)
{
    int left = pieces / 2, middle = begin + (int)((long long)(end - begin) * left / pieces);
    int *nodes = c->piece_nodes + begin;
    if (pieces == 1) {
        c->piece_start[piece] = begin;
        for (int k = begin; k < end; k++)
            c->piece_of[c->piece_nodes[k]] = piece;
        return piece + 1;
    }
    sbi_precond_sort_nodes(c->positions, sbi_precond_longest_axis(c->positions, nodes, end - begin), nodes,
                           end - begin);
    piece = sbi_precond_cut(c, begin, middle, left, piece);
    return sbi_precond_cut(c, middle, end, pieces - left, piece);
}

/* Numbers the (piece, node) entries that A Z has: entry_of[q] is that of matrix block q. Returns their count;
 * fills the coarse arrays when they are there. marker [row_count] is scratch. */
static int sbi_precond_list_entries(sbi_precond_coarse *c, const sb_matrix *a, int *marker, int *entry_of)
{
    int entries = 0;
    for (int i = 0; i < a->row_count; i++)
        marker[i] = -1;
    for (int piece = 0; piece < c->piece_count; piece++) {
        int first = entries;
        c->piece_entry[piece] = entries;
        for (int k = c->piece_start[piece]; k < c->piece_start[piece + 1]; k++) {
            int j = c->piece_nodes[k];
            for (int q = a->row_start[j]; q < a->row_start[j + 1]; q++) {
                int i = a->columns[q];
                if (marker[i] < first) {
                    marker[i] = entries;
                    if (c->entry_node)
                        c->entry_node[entries] = i;
                    entries++;
                }
                entry_of[a->transpose[q]] = marker[i];
            }
        }
    }
    c->piece_entry[c->piece_count] = entries;
    return entries;
}

static int sbi_precond_make_entries(sb_preconditioner *p, const sb_matrix *a)
{
    sbi_precond_coarse *c = &p->coarse;
    size_t rows = (size_t)a->row_count, blocks = (size_t)a->block_count;
    int *scratch = (int *)sbi_alloc(&p->allocator, rows + blocks, sizeof(int)), *entry_of, entries;
    if (!scratch)
        return 0;
    entry_of = scratch + rows;
    entries = sbi_precond_list_entries(c, a, scratch, entry_of);
    c->entry_node = sbi_precond_take_ints(p, (size_t)entries);
    c->entry_start = sbi_precond_take_ints(p, (size_t)entries + 2);
    c->entry_blocks = sbi_precond_take_ints(p, blocks);
    c->coupling = sbi_precond_take_floats(p, (size_t)entries, 24);
    if (c->entry_node && c->entry_start && c->entry_blocks && c->coupling) {
        sbi_precond_list_entries(c, a, scratch, entry_of);
        memset(c->entry_start, 0, ((size_t)entries + 2) * sizeof(int));
        for (int q = 0; q < a->block_count; q++)
            c->entry_start[entry_of[q] + 2]++;
        for (int e = 0; e < entries; e++)
            c->entry_start[e + 2] += c->entry_start[e + 1];
        for (int q = 0; q < a->block_count; q++)
            c->entry_blocks[c->entry_start[entry_of[q] + 1]++] = q;
    }
    sbi_free(&p->allocator, scratch);
    return c->entry_node && c->entry_start && c->entry_blocks && c->coupling;
}

static int sbi_precond_make_coarse(sb_preconditioner *p, const sb_matrix *a, const sb_vec3 *positions,
                                   int pieces)
{
    sbi_precond_coarse *c = &p->coarse;
    size_t rows = (size_t)a->row_count, size = 6 * (size_t)pieces;
    if (size > INT_MAX)
        return 0;
    c->piece_start = sbi_precond_take_ints(p, (size_t)pieces + 1);
    c->piece_entry = sbi_precond_take_ints(p, (size_t)pieces + 1);
    c->piece_nodes = sbi_precond_take_ints(p, rows);
    c->piece_of = sbi_precond_take_ints(p, rows);
    c->arms = sbi_precond_take_floats(p, rows, 4);
    c->free = sbi_precond_take_floats(p, rows, 4);
    c->places = (sb_real *)sbi_precond_take(p, rows, 4 * sizeof(sb_real));
    c->matrix = (double *)sbi_precond_take(p, size, size * sizeof(double));
    c->inverse = (double *)sbi_precond_take(p, size, sizeof(double));
    c->solution = (double *)sbi_precond_take(p, size, sizeof(double));
    c->positions = (sb_vec3 *)sbi_precond_take(p, rows, sizeof(sb_vec3));
    if (!c->piece_start || !c->piece_entry || !c->piece_nodes || !c->piece_of || !c->arms || !c->free ||
        !c->places || !c->matrix || !c->inverse || !c->solution || !c->positions)
        return 0;
    memcpy(c->positions, positions, rows * sizeof(sb_vec3));
    for (int i = 0; i < a->row_count; i++)
        c->piece_nodes[i] = i;
    c->piece_count = sbi_precond_cut(c, 0, a->row_count, pieces, 0);
    c->piece_start[pieces] = a->row_count;
    c->size = (int)size;
    return sbi_precond_make_entries(p, a);
}

/* Positions of the nodes relative to their piece's centre, in units of its root mean square radius. */
static void sbi_precond_place_piece(sbi_precond_coarse *c, int piece)
{
    int begin = c->piece_start[piece], end = c->piece_start[piece + 1];
    double centre[3] = {0, 0, 0}, square = 0, scale;
    for (int k = begin; k < end; k++)
        for (int axis = 0; axis < 3; axis++)
            centre[axis] += (double)sbi_precond_coordinate(c->positions, c->piece_nodes[k], axis);
    for (int axis = 0; axis < 3; axis++)
        centre[axis] /= end - begin;
    for (int k = begin; k < end; k++)
        for (int axis = 0; axis < 3; axis++) {
            double arm = (double)sbi_precond_coordinate(c->positions, c->piece_nodes[k], axis) - centre[axis];
            square += arm * arm;
        }
    scale = square > 0 ? 1 / sqrt(square / (end - begin)) : 0;
    for (int k = begin; k < end; k++) {
        size_t at = 4 * (size_t)c->piece_nodes[k];
        for (int axis = 0; axis < 3; axis++) {
            double x = (double)sbi_precond_coordinate(c->positions, c->piece_nodes[k], axis) - centre[axis];
            c->places[at + (size_t)axis] = (sb_real)(x * scale);
            c->arms[at + (size_t)axis] = (float)(x * scale);
        }
        c->places[at + 3] = 0;
        c->arms[at + 3] = 0;
    }
}

/* Sums over the blocks of entry e: sum[0] of the blocks, sum[1..3] of the blocks times the x, y, z of their
 * node's arm; rows padded to four. */
#if SBI_HAS_LANES
static void sbi_precond_moments(const sbi_precond_coarse *c, const sb_matrix *a, int e, sb_real sum[4][12])
{
    sbi_lanes p0 = {0, 0, 0, 0}, p1 = p0, p2 = p0, x0 = p0, x1 = p0, x2 = p0, y0 = p0, y1 = p0, y2 = p0,
              z0 = p0;
    sbi_lanes z1 = p0, z2 = p0;
    for (int s = c->entry_start[e]; s < c->entry_start[e + 1]; s++) {
        const sb_real *block = a->blocks[c->entry_blocks[s]];
        const sb_real *arm = c->places + 4 * (size_t)a->columns[c->entry_blocks[s]];
        sbi_lanes r0 = SBI_LANES_AT(block), r1 = SBI_LANES_AT(block + 3), r2 = SBI_LANES_AT(block + 6);
        p0 += r0, x0 += r0 * arm[0], y0 += r0 * arm[1], z0 += r0 * arm[2];
        p1 += r1, x1 += r1 * arm[0], y1 += r1 * arm[1], z1 += r1 * arm[2];
        p2 += r2, x2 += r2 * arm[0], y2 += r2 * arm[1], z2 += r2 * arm[2];
    }
    SBI_LANES_PUT(sum[0], p0), SBI_LANES_PUT(sum[0] + 4, p1), SBI_LANES_PUT(sum[0] + 8, p2);
    SBI_LANES_PUT(sum[1], x0), SBI_LANES_PUT(sum[1] + 4, x1), SBI_LANES_PUT(sum[1] + 8, x2);
    SBI_LANES_PUT(sum[2], y0), SBI_LANES_PUT(sum[2] + 4, y1), SBI_LANES_PUT(sum[2] + 8, y2);
    SBI_LANES_PUT(sum[3], z0), SBI_LANES_PUT(sum[3] + 4, z1), SBI_LANES_PUT(sum[3] + 8, z2);
}
#else
static void sbi_precond_moments(const sbi_precond_coarse *c, const sb_matrix *a, int e, sb_real sum[4][12])
{
    memset(sum, 0, 4 * sizeof *sum);
    for (int s = c->entry_start[e]; s < c->entry_start[e + 1]; s++) {
        const sb_real *block = a->blocks[c->entry_blocks[s]];
        const sb_real *arm = c->places + 4 * (size_t)a->columns[c->entry_blocks[s]];
        for (int r = 0; r < 3; r++)
            for (int k = 0; k < 3; k++) {
                sb_real value = block[3 * r + k];
                sum[0][4 * r + k] += value;
                sum[1][4 * r + k] += value * arm[0];
                sum[2][4 * r + k] += value * arm[1];
                sum[3][4 * r + k] += value * arm[2];
            }
    }
}
#endif

/* Rows of (A Z) of one entry: sums over the piece's nodes j of A_ij and A_ij d_j,k give the translations and,
 * by a . (w x d) = w . (d x a), the rotations. */
static void sbi_precond_couple(const sb_preconditioner *p, const sb_matrix *a, int e, double rows[3][6])
{
    const sbi_precond_coarse *c = &p->coarse;
    sb_real sum[4][12];
    sbi_precond_moments(c, a, e, sum);
    for (int r = 0; r < 3; r++) {
        double factor = p->matrix_scale * (double)c->free[4 * (size_t)c->entry_node[e] + (size_t)r];
        for (int k = 0; k < 3; k++)
            rows[r][k] = (double)sum[0][4 * r + k] * factor;
        rows[r][3] = (double)(sum[2][4 * r + 2] - sum[3][4 * r + 1]) * factor;
        rows[r][4] = (double)(sum[3][4 * r] - sum[1][4 * r + 2]) * factor;
        rows[r][5] = (double)(sum[1][4 * r + 1] - sum[2][4 * r]) * factor;
    }
}

/* (Z^T A Z) += Z_i^T (A Z)_i, the rows of node i's piece. */
static void sbi_precond_add_coarse(sbi_precond_coarse *c, int node, int piece, double rows[3][6])
{
    double *out = c->matrix + 6 * (size_t)c->piece_of[node] * (size_t)c->size + 6 * (size_t)piece;
    const float *arm = c->arms + 4 * (size_t)node;
    double x = (double)arm[0], y = (double)arm[1], z = (double)arm[2];
    size_t next = (size_t)c->size;
    for (int k = 0; k < 6; k++) {
        out[k] += rows[0][k];
        out[next + (size_t)k] += rows[1][k];
        out[2 * next + (size_t)k] += rows[2][k];
        out[3 * next + (size_t)k] += y * rows[2][k] - z * rows[1][k];
        out[4 * next + (size_t)k] += z * rows[0][k] - x * rows[2][k];
        out[5 * next + (size_t)k] += x * rows[1][k] - y * rows[0][k];
    }
}

/* The six rows of a piece: each is scaled by its pivot and taken from the following ones. */
static void sbi_precond_factor_rows(sbi_precond_coarse *c, int first)
{
    int size = c->size;
    for (int k = first; k < first + 6; k++) {
        double *row = c->matrix + (size_t)k * (size_t)size, pivot = row[k];
        c->inverse[k] = pivot > 0 && pivot > c->solution[k] ? 1 / sqrt(pivot) : 0;
        for (int j = k; j < size; j++)
            row[j] *= c->inverse[k];
        for (int i = k + 1; i < first + 6; i++) {
            double *other = c->matrix + (size_t)i * (size_t)size, factor = row[i];
            for (int j = i; j < size; j++)
                other[j] -= factor * row[j];
        }
    }
}

/* to[i..] -= sum over six rows of row[i] row[i..]; six at a time, since it is memory that limits the
 * factorisation. */
static void sbi_precond_eliminate_rows(const double *rows, int size, int i, double *SB_RESTRICT to)
{
    const double *r0 = rows, *r1 = r0 + size, *r2 = r1 + size, *r3 = r2 + size, *r4 = r3 + size,
                 *r5 = r4 + size;
    double f0 = r0[i], f1 = r1[i], f2 = r2[i], f3 = r3[i], f4 = r4[i], f5 = r5[i];
    if (f0 == 0 && f1 == 0 && f2 == 0 && f3 == 0 && f4 == 0 && f5 == 0)
        return; /* pieces that do not touch */
    for (int j = i; j < size; j++)
        to[j] -= ((f0 * r0[j] + f1 * r1[j]) + (f2 * r2[j] + f3 * r3[j])) + (f4 * r4[j] + f5 * r5[j]);
}

/* Cholesky factor R of the coarse matrix, R^T R, in its upper triangle. Motions that a piece does not have
 * (all its nodes fixed, or on a line) leave a zero pivot and are left out. */
static void sbi_precond_factor_coarse(sbi_precond_coarse *c)
{
    const double tiny = 256 * (double)SB_EPSILON;
    int size = c->size;
    for (int k = 0; k < size; k++)
        c->solution[k] = tiny * c->matrix[(size_t)k * (size_t)size + (size_t)k];
    for (int first = 0; first < size; first += 6) {
        double *rows = c->matrix + (size_t)first * (size_t)size;
        sbi_precond_factor_rows(c, first);
        for (int i = first + 6; i < size; i++)
            sbi_precond_eliminate_rows(rows, size, i, c->matrix + (size_t)i * (size_t)size);
    }
}

static void sbi_precond_update_coarse(sb_preconditioner *p, const sb_matrix *a)
{
    sbi_precond_coarse *c = &p->coarse;
    for (int piece = 0; piece < c->piece_count; piece++)
        sbi_precond_place_piece(c, piece);
    for (int i = 0; i < a->row_count; i++)
        for (int k = 0; k < 4; k++)
            c->free[4 * (size_t)i + (size_t)k] = (a->fixed[i] >> k & 1) || k == 3 ? 0.0f : 1.0f;
    memset(c->matrix, 0, (size_t)c->size * (size_t)c->size * sizeof(double));
    for (int piece = 0; piece < c->piece_count; piece++)
        for (int e = c->piece_entry[piece]; e < c->piece_entry[piece + 1]; e++) {
            double rows[3][6];
            float *out = c->coupling + 24 * (size_t)e;
            sbi_precond_couple(p, a, e, rows);
            for (int r = 0; r < 3; r++) {
                sbi_f4_store(out + 4 * r,
                             sbi_f4_make((float)rows[r][0], (float)rows[r][1], (float)rows[r][2]));
                sbi_f4_store(out + 12 + 4 * r,
                             sbi_f4_make((float)rows[r][3], (float)rows[r][4], (float)rows[r][5]));
            }
            if (c->piece_of[c->entry_node[e]] <= piece)
                sbi_precond_add_coarse(c, c->entry_node[e], piece, rows);
        }
    sbi_precond_factor_coarse(c);
}

/* solution = (R^T R)^-1 solution. */
static void sbi_precond_solve_coarse(sbi_precond_coarse *c)
{
    double *v = c->solution;
    int size = c->size;
    for (int k = 0; k < size; k++) {
        const double *row = c->matrix + (size_t)k * (size_t)size;
        double value = v[k] *= c->inverse[k];
        for (int j = k + 1; j < size; j++)
            v[j] -= value * row[j];
    }
    for (int k = size; k-- > 0;) {
        const double *row = c->matrix + (size_t)k * (size_t)size;
        double sums[4] = {0, 0, 0, 0}, value = v[k];
        int j = k + 1;
        for (; j + 4 <= size; j += 4)
            for (int lane = 0; lane < 4; lane++)
                sums[lane] += row[j + lane] * v[j + lane];
        for (; j < size; j++)
            sums[0] += row[j] * v[j];
        value -= (sums[0] + sums[1]) + (sums[2] + sums[3]);
        v[k] = value * c->inverse[k];
    }
}

/* ---- application --------------------------------------------------------------------------------------- */

/* middle = (I + L)^-1 r, result = D^-1 middle. */
static void sbi_precond_forward(sb_preconditioner *p, const sb_real *r, sb_real scale)
{
    const float *l = p->lower;
    for (size_t i = 0; i < (size_t)p->row_count; i++) {
        sbi_float4 s0 = sbi_f4_make(0, 0, 0), s1 = s0, s2 = s0, y;
        for (int e = p->start[i]; e < p->start[i + 1]; e++, l += 12) {
            sbi_float4 v = sbi_f4_load(p->middle + 4 * (size_t)p->columns[e]);
            s0 = sbi_f4_add(s0, sbi_f4_mul(sbi_f4_load(l), v));
            s1 = sbi_f4_add(s1, sbi_f4_mul(sbi_f4_load(l + 4), v));
            s2 = sbi_f4_add(s2, sbi_f4_mul(sbi_f4_load(l + 8), v));
        }
        y = sbi_f4_sub(sbi_f4_round(r + 3 * i, scale),
                       sbi_f4_make(sbi_f4_sum(s0), sbi_f4_sum(s1), sbi_f4_sum(s2)));
        sbi_f4_store(p->middle + 4 * i, y);
        sbi_f4_store(p->result + 4 * i, sbi_f4_rows(y, p->inverse + 12 * i));
    }
}

/* result = (I + L)^-T result, by columns of L^T: each row is final when it is met. */
static void sbi_precond_backward(sb_preconditioner *p)
{
    for (int i = p->row_count; i-- > 0;) {
        sbi_float4 z = sbi_f4_load(p->result + 4 * (size_t)i);
        const float *l = p->lower + 12 * (size_t)p->start[i];
        for (int e = p->start[i]; e < p->start[i + 1]; e++, l += 12) {
            float *to = p->result + 4 * (size_t)p->columns[e];
            sbi_f4_store(to, sbi_f4_sub(sbi_f4_load(to), sbi_f4_rows(z, l)));
        }
    }
}

static void sbi_precond_scale_blocks(sb_preconditioner *p, const sb_real *r, sb_real scale)
{
    for (size_t i = 0; i < (size_t)p->row_count; i++)
        sbi_f4_store(p->result + 4 * i, sbi_f4_rows(sbi_f4_round(r + 3 * i, scale), p->inverse + 12 * i));
}

/* Z^T r of one piece, minus (A Z)^T result if asked: a force, and a torque from the sums of arm components
 * times force (no cross products in the loop). */
static void sbi_precond_restrict_piece(const sb_preconditioner *p, const sb_real *r, sb_real scale,
                                       int with_result, int piece, double *out)
{
    const sbi_precond_coarse *c = &p->coarse;
    sbi_float4 force = sbi_f4_make(0, 0, 0), by_x = force, by_y = force, by_z = force, torque;
    for (int k = c->piece_start[piece]; k < c->piece_start[piece + 1]; k++) {
        size_t i = (size_t)c->piece_nodes[k];
        const float *arm = c->arms + 4 * i;
        sbi_float4 f = sbi_f4_mul(sbi_f4_round(r + 3 * i, scale), sbi_f4_load(c->free + 4 * i));
        force = sbi_f4_add(force, f);
        by_x = sbi_f4_add(by_x, sbi_f4_scale(arm[0], f));
        by_y = sbi_f4_add(by_y, sbi_f4_scale(arm[1], f));
        by_z = sbi_f4_add(by_z, sbi_f4_scale(arm[2], f));
    }
    torque = sbi_f4_make(SBI_F4(by_y, 2) - SBI_F4(by_z, 1), SBI_F4(by_z, 0) - SBI_F4(by_x, 2),
                         SBI_F4(by_x, 1) - SBI_F4(by_y, 0));
    for (int e = c->piece_entry[piece]; with_result && e < c->piece_entry[piece + 1]; e++) {
        sbi_float4 z = sbi_f4_load(p->result + 4 * (size_t)c->entry_node[e]);
        force = sbi_f4_sub(force, sbi_f4_rows(z, c->coupling + 24 * (size_t)e));
        torque = sbi_f4_sub(torque, sbi_f4_rows(z, c->coupling + 24 * (size_t)e + 12));
    }
    for (int k = 0; k < 3; k++) {
        out[k] = (double)SBI_F4(force, k);
        out[3 + k] = (double)SBI_F4(torque, k);
    }
}

/* solution = Z^T r - (A Z)^T result, or Z^T r */
static void sbi_precond_restrict(sb_preconditioner *p, const sb_real *r, sb_real scale, int with_result)
{
    for (int piece = 0; piece < p->coarse.piece_count; piece++)
        sbi_precond_restrict_piece(p, r, scale, with_result, piece, p->coarse.solution + 6 * piece);
}

/* result += Z solution: shift + w x d = shift + (w x e_x) d_x + (w x e_y) d_y + (w x e_z) d_z */
static void sbi_precond_prolong(sb_preconditioner *p)
{
    sbi_precond_coarse *c = &p->coarse;
    for (int piece = 0; piece < c->piece_count; piece++) {
        const double *s = c->solution + 6 * piece;
        float wx = (float)s[3], wy = (float)s[4], wz = (float)s[5];
        sbi_float4 shift = sbi_f4_make((float)s[0], (float)s[1], (float)s[2]);
        sbi_float4 by_x = sbi_f4_make(0, wz, -wy), by_y = sbi_f4_make(-wz, 0, wx),
                   by_z = sbi_f4_make(wy, -wx, 0);
        for (int k = c->piece_start[piece]; k < c->piece_start[piece + 1]; k++) {
            size_t i = (size_t)c->piece_nodes[k];
            const float *arm = c->arms + 4 * i;
            sbi_float4 move = sbi_f4_add(shift, sbi_f4_scale(arm[0], by_x));
            move = sbi_f4_add(move, sbi_f4_scale(arm[1], by_y));
            move = sbi_f4_mul(sbi_f4_add(move, sbi_f4_scale(arm[2], by_z)), sbi_f4_load(c->free + 4 * i));
            sbi_f4_store(p->result + 4 * i, sbi_f4_add(sbi_f4_load(p->result + 4 * i), move));
        }
    }
}

/* The power of two that brings `size` near 1. */
static double sbi_precond_power(double size)
{
    int exponent = 0;
    frexp(size, &exponent);
    return ldexp(1, exponent > 1000 ? -1000 : exponent < -1000 ? 1000 : -exponent);
}

static void sbi_precond_write(const sb_preconditioner *p, sb_real *z, double scale)
{
    sb_real back = (sb_real)(p->matrix_scale / scale);
    for (size_t i = 0; i < (size_t)p->row_count; i++)
        for (size_t k = 0; k < 3; k++)
            z[3 * i + k] = (sb_real)p->result[4 * i + k] * back;
}

SBI_API void sbi_precond_apply(sb_preconditioner *p, const sb_real *r, sb_real *z, double size)
{
    double scale = sbi_precond_power(size);
    if (p->kind == SB_PRECOND_NONE) {
        memcpy(z, r, 3 * (size_t)p->row_count * sizeof(sb_real));
        return;
    }
    if (p->kind == SB_PRECOND_BLOCK_JACOBI) {
        sbi_precond_scale_blocks(p, r, (sb_real)scale);
    } else {
        sbi_precond_forward(p, r, (sb_real)scale);
        sbi_precond_backward(p);
    }
    if (p->coarse.piece_count) {
        sbi_precond_restrict(p, r, (sb_real)scale, 1);
        sbi_precond_solve_coarse(&p->coarse);
        sbi_precond_prolong(p);
    }
    sbi_precond_write(p, z, scale);
}

SBI_API int sbi_precond_coarse_solve(sb_preconditioner *p, const sb_real *r, sb_real *z, double size)
{
    double scale = sbi_precond_power(size);
    if (!p->coarse.piece_count)
        return 0;
    sbi_precond_restrict(p, r, (sb_real)scale, 0);
    sbi_precond_solve_coarse(&p->coarse);
    memset(p->result, 0, (size_t)p->row_count * 4 * sizeof(float));
    sbi_precond_prolong(p);
    sbi_precond_write(p, z, scale);
    return 1;
}

SB_API void sb_preconditioner_apply(sb_preconditioner *preconditioner, const sb_real *r, sb_real *z)
{
    sb_real largest = 0;
    for (size_t k = 0; k < 3 * (size_t)preconditioner->row_count; k++) {
        sb_real size = r[k] < 0 ? -r[k] : r[k];
        largest = size > largest ? size : largest;
    }
    sbi_precond_apply(preconditioner, r, z, (double)largest);
}

/* ---- life ---------------------------------------------------------------------------------------------- */

SB_API sb_preconditioner_def sb_default_preconditioner_def(void)
{
    sb_preconditioner_def def;
    def.kind = SB_PRECOND_AUTO;
    def.positions = NULL;
    def.piece_count = SB_PRECOND_PIECES_AUTO;
    return def;
}

static int sbi_precond_pieces(const sb_preconditioner_def *def, int rows)
{
    int pieces = rows / SBI_PRECOND_NODES_PER_PIECE;
    if (!def->positions || def->kind == SB_PRECOND_NONE)
        return 0;
    if (def->piece_count != SB_PRECOND_PIECES_AUTO)
        return def->piece_count;
    return pieces < SBI_PRECOND_MAX_PIECES ? pieces : SBI_PRECOND_MAX_PIECES;
}

static sb_result sbi_precond_check(const sb_preconditioner_def *def, const sb_matrix *pattern,
                                   sb_error *error)
{
    if (!def || !pattern || pattern->row_count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a preconditioner needs a def and a matrix");
    if ((int)def->kind < SB_PRECOND_NONE || (int)def->kind > SB_PRECOND_AUTO)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "unknown preconditioner kind %d", (int)def->kind);
    if (def->piece_count < SB_PRECOND_PIECES_AUTO || def->piece_count > pattern->row_count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "piece_count %d is outside 0 to %d", def->piece_count,
                        pattern->row_count);
    for (int i = 0; def->positions && i < pattern->row_count; i++)
        if (!sb_v3_is_finite(def->positions[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "node %d: position is not finite", i);
    return SB_OK;
}

static int sbi_precond_make(sb_preconditioner *p, const sb_preconditioner_def *def, const sb_matrix *a)
{
    size_t rows = (size_t)a->row_count;
    int pieces = sbi_precond_pieces(def, a->row_count);
    if (p->kind == SB_PRECOND_NONE)
        return 1;
    p->inverse = sbi_precond_take_floats(p, rows, 12);
    p->middle = sbi_precond_take_floats(p, rows, 4);
    p->result = sbi_precond_take_floats(p, rows, 4);
    if (!p->inverse || !p->middle || !p->result)
        return 0;
    if (p->kind != SB_PRECOND_BLOCK_JACOBI && !sbi_precond_make_lower(p, a))
        return 0;
    if (p->kind == SB_PRECOND_IC0 && !sbi_precond_make_pairs(p))
        return 0;
    return pieces == 0 || sbi_precond_make_coarse(p, a, def->positions, pieces);
}

SB_API sb_result sb_preconditioner_create(const sb_preconditioner_def *def, const sb_matrix *pattern,
                                          const sb_allocator *allocator, sb_preconditioner **out,
                                          sb_error *error)
{
    sb_preconditioner *p;
    sb_result result = sbi_precond_check(def, pattern, error);
    if (result != SB_OK)
        return result;
    if (!out)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_preconditioner_create needs a place for its result");
    p = (sb_preconditioner *)sbi_alloc_zeroed(allocator, 1, sizeof *p);
    if (!p)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a preconditioner");
    if (allocator)
        p->allocator = *allocator;
    p->bytes = sizeof *p;
    p->kind = def->kind == SB_PRECOND_AUTO ? SB_PRECOND_IC0 : def->kind;
    p->row_count = pattern->row_count;
    p->block_count = pattern->block_count;
    p->lower_count = (pattern->block_count - pattern->row_count) / 2;
    p->wait = SBI_PRECOND_RELAX_FIRST;
    p->matrix_scale = 1;
    if (!sbi_precond_make(p, def, pattern)) {
        sb_preconditioner_free(p);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a preconditioner of %d rows",
                        pattern->row_count);
    }
    *out = p;
    return SB_OK;
}

SB_API sb_result sb_preconditioner_update(sb_preconditioner *p, const sb_matrix *matrix,
                                          const sb_vec3 *positions, sb_error *error)
{
    double scale;
    int bad = -1;
    if (!p || !matrix || matrix->row_count != p->row_count || matrix->block_count != p->block_count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the matrix does not have the preconditioner's pattern");
    scale = (double)sb_matrix_diagonal_scale(matrix, NULL);
    if (!(scale - scale == 0))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the matrix has a diagonal entry that is not finite");
    for (int i = 0; positions && p->coarse.piece_count && i < p->row_count; i++)
        if (!sb_v3_is_finite(positions[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "node %d: position is not finite", i);
    p->matrix_scale = sbi_precond_power(scale);
    p->attempts = 0;
    if (p->kind == SB_PRECOND_BLOCK_JACOBI || p->kind == SB_PRECOND_SSOR)
        bad = sbi_precond_invert_diagonals(p, matrix);
    if (bad >= 0)
        return sbi_fail_node(error, SB_ERROR_INDEFINITE, bad,
                             "node %d: diagonal block is not positive definite", bad);
    if (p->kind == SB_PRECOND_SSOR)
        sbi_precond_fill_ssor(p, matrix);
    if (p->kind == SB_PRECOND_IC0) {
        sb_result result = sbi_precond_update_ic0(p, matrix, error);
        if (result != SB_OK)
            return result;
    }
    if (p->coarse.piece_count) {
        if (positions)
            memcpy(p->coarse.positions, positions, (size_t)p->row_count * sizeof(sb_vec3));
        sbi_precond_update_coarse(p, matrix);
    }
    return SB_OK;
}

SBI_API int sbi_precond_rows(const sb_preconditioner *preconditioner) { return preconditioner->row_count; }

SB_API sb_preconditioner_info sb_preconditioner_get_info(const sb_preconditioner *preconditioner)
{
    sb_preconditioner_info info;
    info.kind = preconditioner->kind;
    info.piece_count = preconditioner->coarse.piece_count;
    info.attempts = preconditioner->attempts;
    info.shift = preconditioner->shift;
    info.bytes = preconditioner->bytes;
    return info;
}

#undef SBI_F4
#undef SBI_HAS_FLOAT4

/* ==== src/softbody/pcg.c ==== */
/* pcg: conjugate gradients with fused vector loops. */

#include <math.h>
#include <string.h>

/* ---- workspace ----------------------------------------------------------------------------------------- */

SB_API sb_pcg_options sb_default_pcg_options(void)
{
    sb_pcg_options options;
    options.tolerance = SB_REAL_IS_FLOAT ? 1e-3 : 1e-6;
    options.max_iterations = 1000;
    options.jobs = NULL;
    return options;
}

SB_API sb_result sb_pcg_workspace_create(int row_count, const sb_allocator *allocator,
                                         sb_pcg_workspace *workspace, sb_error *error)
{
    sb_pcg_workspace made;
    size_t entries, bytes = 0;
    if (!workspace || row_count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a workspace needs row_count >= 1, not %d", row_count);
    memset(&made, 0, sizeof made);
    if (allocator)
        made.allocator = *allocator;
    entries = 3 * (size_t)row_count;
    if (sbi_size_add(&bytes, (size_t)sbi_row_chunks(row_count), 2 * sizeof(double)) &&
        sbi_size_add(&bytes, entries, 5 * sizeof(sb_real)))
        made.memory = sbi_alloc(allocator, bytes, 1);
    if (!made.memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the vectors of %d rows", row_count);
    made.row_count = row_count;
    made.partial = (double *)made.memory;
    made.start = (sb_real *)(void *)(made.partial + 2 * sbi_row_chunks(row_count));
    made.residual = made.start + entries;
    made.search = made.residual + entries;
    made.direction = made.search + entries;
    made.product = made.direction + entries;
    *workspace = made;
    return SB_OK;
}

SB_API void sb_pcg_workspace_free(sb_pcg_workspace *workspace)
{
    if (!workspace)
        return;
    sbi_free(&workspace->allocator, workspace->memory);
    memset(workspace, 0, sizeof *workspace);
}

/* ---- vector loops -------------------------------------------------------------------------------------- */

/* What the chunk tasks see. Names follow the usual ones: r residual, z = M^-1 r, p direction, q = A p. */
typedef struct sbi_pcg_state {
    const sb_matrix *matrix;
    const sb_real *rhs;
    sb_real *x, *r, *z, *p, *q;
    sb_real factor;  /* of the update at work */
    double *partial; /* [chunks][2] */
    const sb_jobs *jobs;
} sbi_pcg_state;

static size_t sbi_pcg_end(const sbi_pcg_state *s, int chunk)
{
    int rows = s->matrix->row_count, first = chunk * SBI_ROW_CHUNK;
    return 3 * (size_t)(rows - first < SBI_ROW_CHUNK ? rows : first + SBI_ROW_CHUNK);
}

/* a.b over a range: eight sums that do not wait for each other. */
static double sbi_pcg_dot(const sb_real *a, const sb_real *b, size_t count)
{
    double s0 = 0, s1 = 0, s2 = 0, s3 = 0, s4 = 0, s5 = 0, s6 = 0, s7 = 0;
    size_t k = 0;
    for (; k + 8 <= count; k += 8) {
        s0 += (double)a[k] * (double)b[k];
        s1 += (double)a[k + 1] * (double)b[k + 1];
        s2 += (double)a[k + 2] * (double)b[k + 2];
        s3 += (double)a[k + 3] * (double)b[k + 3];
        s4 += (double)a[k + 4] * (double)b[k + 4];
        s5 += (double)a[k + 5] * (double)b[k + 5];
        s6 += (double)a[k + 6] * (double)b[k + 6];
        s7 += (double)a[k + 7] * (double)b[k + 7];
    }
    for (; k < count; k++)
        s0 += (double)a[k] * (double)b[k];
    return ((s0 + s1) + (s2 + s3)) + ((s4 + s5) + (s6 + s7));
}

static void sbi_pcg_square_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    size_t begin = 3 * (size_t)chunk * SBI_ROW_CHUNK, count = sbi_pcg_end(s, chunk) - begin;
    s->partial[2 * chunk] = sbi_pcg_dot(s->rhs + begin, s->rhs + begin, count);
    s->partial[2 * chunk + 1] = sbi_pcg_dot(s->x + begin, s->x + begin, count);
}

/* r = rhs - A x, r.r */
static void sbi_pcg_residual_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    size_t begin = 3 * (size_t)chunk * SBI_ROW_CHUNK, end = sbi_pcg_end(s, chunk);
    sbi_matrix_multiply_rows(s->matrix, s->x, s->r, (int)(begin / 3), (int)(end / 3));
    for (size_t k = begin; k < end; k++)
        s->r[k] = s->rhs[k] - s->r[k];
    s->partial[2 * chunk] = sbi_pcg_dot(s->r + begin, s->r + begin, end - begin);
}

/* q = A p, p.q */
static void sbi_pcg_product_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    size_t begin = 3 * (size_t)chunk * SBI_ROW_CHUNK, end = sbi_pcg_end(s, chunk);
    sbi_matrix_multiply_rows(s->matrix, s->p, s->q, (int)(begin / 3), (int)(end / 3));
    s->partial[2 * chunk] = sbi_pcg_dot(s->p + begin, s->q + begin, end - begin);
}

/* x += factor p, r -= factor q, r.r */
static void sbi_pcg_advance_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    size_t begin = 3 * (size_t)chunk * SBI_ROW_CHUNK, count = sbi_pcg_end(s, chunk) - begin;
    sb_real *SB_RESTRICT x = s->x + begin, *SB_RESTRICT r = s->r + begin;
    const sb_real *p = s->p + begin, *q = s->q + begin;
    sb_real factor = s->factor;
    for (size_t k = 0; k < count; k++) {
        x[k] += factor * p[k];
        r[k] -= factor * q[k];
    }
    s->partial[2 * chunk] = sbi_pcg_dot(r, r, count);
}

/* r.z and q.z */
static void sbi_pcg_dots_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    size_t begin = 3 * (size_t)chunk * SBI_ROW_CHUNK, count = sbi_pcg_end(s, chunk) - begin;
    s->partial[2 * chunk] = sbi_pcg_dot(s->r + begin, s->z + begin, count);
    s->partial[2 * chunk + 1] = sbi_pcg_dot(s->q + begin, s->z + begin, count);
}

/* p = z + factor p */
static void sbi_pcg_direction_task(void *user, int chunk)
{
    const sbi_pcg_state *s = (const sbi_pcg_state *)user;
    size_t begin = 3 * (size_t)chunk * SBI_ROW_CHUNK, count = sbi_pcg_end(s, chunk) - begin;
    sb_real *SB_RESTRICT p = s->p + begin;
    const sb_real *SB_RESTRICT z = s->z + begin;
    sb_real factor = s->factor;
    for (size_t k = 0; k < count; k++)
        p[k] = z[k] + factor * p[k];
}

/* Runs a task over all chunks; the sum of the chunks' first (or second) partial sums, in order. */
static double sbi_pcg_run(sbi_pcg_state *s, sb_task task, double *second)
{
    int chunks = sbi_row_chunks(s->matrix->row_count);
    double sum = 0, other = 0;
    sbi_run(s->jobs, task, s, chunks);
    for (int k = 0; k < chunks; k++)
        sum += s->partial[2 * k];
    for (int k = 0; second && k < chunks; k++)
        other += s->partial[2 * k + 1];
    if (second)
        *second = other;
    return sum;
}

/* ---- the iteration ------------------------------------------------------------------------------------- */

static int sbi_pcg_is_finite(double value) { return value - value == 0; }

/* Subtracts the coarse space's part from the residual, as its deflation requires; returns the new r.r. Uses p
 * and q. */
static double sbi_pcg_deflate(sbi_pcg_state *s, sb_preconditioner *preconditioner, double square)
{
    if (!preconditioner || !sbi_precond_coarse_solve(preconditioner, s->r, s->p, sqrt(square)))
        return square;
    sbi_pcg_run(s, sbi_pcg_product_task, NULL);
    s->factor = 1;
    return sbi_pcg_run(s, sbi_pcg_advance_task, NULL);
}

/* Iterates until r.r <= target, in plain PCG with the flexible beta = (r_new - r).z_new / (r.z)_old: with
 * r_new - r = -alpha q it costs one more sum and makes up for a preconditioner that rounding keeps from being
 * quite symmetric. */
static sb_result sbi_pcg_iterate(sbi_pcg_state *s, sb_preconditioner *preconditioner, double target,
                                 int max_iterations, double *square, sb_pcg_info *info)
{
    double alpha = 0, last_rz = 0;
    for (int first = 1; *square > target; first = 0) {
        double rz, qz, pq;
        if (info->iterations >= max_iterations) {
            info->capped = 1;
            return SB_ERROR_NOT_CONVERGED;
        }
        if (preconditioner)
            sbi_precond_apply(preconditioner, s->r, s->z, sqrt(*square));
        else
            memcpy(s->z, s->r, 3 * (size_t)s->matrix->row_count * sizeof(sb_real));
        if (first)
            memset(s->p, 0, 3 * (size_t)s->matrix->row_count * sizeof(sb_real));
        if (first)
            memset(s->q, 0, 3 * (size_t)s->matrix->row_count * sizeof(sb_real));
        rz = sbi_pcg_run(s, sbi_pcg_dots_task, &qz);
        if (!sbi_pcg_is_finite(rz))
            return SB_ERROR_DIVERGED;
        if (rz <= 0)
            return SB_ERROR_INDEFINITE;
        s->factor = first ? 0 : (sb_real)(-alpha * qz / last_rz);
        sbi_run(s->jobs, sbi_pcg_direction_task, s, sbi_row_chunks(s->matrix->row_count));
        pq = sbi_pcg_run(s, sbi_pcg_product_task, NULL);
        if (!sbi_pcg_is_finite(pq))
            return SB_ERROR_DIVERGED;
        if (pq <= 0) {
            info->negative_curvature = 1;
            return SB_ERROR_INDEFINITE;
        }
        alpha = rz / pq;
        last_rz = rz;
        s->factor = (sb_real)alpha;
        *square = sbi_pcg_run(s, sbi_pcg_advance_task, NULL);
        if (!sbi_pcg_is_finite(*square))
            return SB_ERROR_DIVERGED;
        info->iterations++;
    }
    return SB_OK;
}

/* Solves, checking the true residual where the recurrence cannot be trusted; *square is r.r of the returned
 * x. */
static sb_result sbi_pcg_refine(sbi_pcg_state *s, sb_preconditioner *preconditioner,
                                const sb_pcg_options *options, double rhs_square, double *square,
                                sb_pcg_info *info)
{
    double tolerance = options->tolerance, target = tolerance * tolerance * rhs_square, before = *square;
    double least =
        (double)SB_EPSILON * (double)SB_EPSILON / 16 * rhs_square; /* below, the recurrence counts nothing */
    int verify = tolerance * tolerance * tolerance < (double)SB_EPSILON;
    for (;;) {
        sb_result result;
        if (*square <= target)
            return SB_OK;
        *square = sbi_pcg_deflate(s, preconditioner, *square);
        if (!sbi_pcg_is_finite(*square))
            return SB_ERROR_DIVERGED;
        result = sbi_pcg_iterate(s, preconditioner, target > least ? target : least, options->max_iterations,
                                 square, info);
        info->residual_is_true = 0;
        if (result != SB_OK || !verify)
            return result;
        *square = sbi_pcg_run(s, sbi_pcg_residual_task, NULL);
        info->residual_is_true = 1;
        if (!sbi_pcg_is_finite(*square))
            return SB_ERROR_DIVERGED;
        if (*square <= target)
            return SB_OK;
        if (*square > 0.25 * before) /* not even halved: the last digit of x is reached */
            return SB_ERROR_NOT_CONVERGED;
        before = *square;
    }
}

static int sbi_pcg_valid(const sb_matrix *matrix, const sb_preconditioner *preconditioner, const sb_real *rhs,
                         const sb_real *x, const sb_pcg_options *options, const sb_pcg_workspace *workspace)
{
    if (!matrix || !rhs || !x || !workspace || workspace->row_count != matrix->row_count)
        return 0;
    if (preconditioner && sbi_precond_rows(preconditioner) != matrix->row_count)
        return 0;
    return options->tolerance >= 0 && sbi_pcg_is_finite(options->tolerance) && options->max_iterations >= 0;
}

SB_API sb_result sb_pcg_solve(const sb_matrix *matrix, sb_preconditioner *preconditioner, const sb_real *rhs,
                              sb_real *x, const sb_pcg_options *options, sb_pcg_workspace *workspace,
                              sb_pcg_info *info)
{
    sb_pcg_options defaults = sb_default_pcg_options();
    sb_pcg_info report;
    sbi_pcg_state state;
    sb_result result;
    double rhs_square, x_square = 0, square = 0;
    size_t bytes;
    options = options ? options : &defaults;
    if (!sbi_pcg_valid(matrix, preconditioner, rhs, x, options, workspace))
        return SB_ERROR_ARGUMENT;
    memset(&report, 0, sizeof report);
    bytes = 3 * (size_t)matrix->row_count * sizeof(sb_real);
    state.matrix = matrix;
    state.rhs = rhs;
    state.x = x;
    state.r = workspace->residual;
    state.z = workspace->search;
    state.p = workspace->direction;
    state.q = workspace->product;
    state.partial = workspace->partial;
    state.jobs = options->jobs;
    state.factor = 0;
    memcpy(workspace->start, x, bytes);
    rhs_square = sbi_pcg_run(&state, sbi_pcg_square_task, &x_square);
    if (rhs_square > 0 && x_square == 0) { /* no product needed */
        memcpy(state.r, rhs, bytes);
        square = rhs_square;
    } else if (rhs_square > 0) {
        square = sbi_pcg_run(&state, sbi_pcg_residual_task, NULL);
    } else if (rhs_square == 0) {
        memset(x, 0, bytes);
    }
    report.residual_is_true = 1;
    if (!sbi_pcg_is_finite(rhs_square) || !sbi_pcg_is_finite(square))
        result = SB_ERROR_DIVERGED;
    else
        result = sbi_pcg_refine(&state, preconditioner, options, rhs_square, &square, &report);
    if (result == SB_ERROR_DIVERGED) {
        memcpy(x, workspace->start, bytes);
        report.residual_is_true = 0;
    }
    report.residual = rhs_square > 0 ? sqrt(square / rhs_square) : 0;
    if (info)
        *info = report;
    return result;
}

/* ==== src/softbody/domain.c ==== */
/* domain: integration points from elements. */

#include <string.h>

SB_API void sb_domain_free(sb_domain *domain)
{
    sb_allocator allocator = domain->allocator;
    sbi_free(&allocator, domain->cells);
    sbi_free(&allocator, domain->gradients);
    sbi_free(&allocator, domain->weights);
    sbi_free(&allocator, domain->corner_gradients);
    memset(domain, 0, sizeof *domain);
}

/* Je_ij = sum_a X_a,i dN_a/dxi_j */
static sb_mat3 sbi_domain_jacobian(int node_count, const sb_vec3 *x, const sb_real (*local_gradient)[3])
{
    sb_mat3 jacobian = sb_m3_zero();
    for (int a = 0; a < node_count; a++)
        for (int j = 0; j < 3; j++) {
            sb_real d = local_gradient[a][j];
            jacobian.m[0][j] += x[a].x * d;
            jacobian.m[1][j] += x[a].y * d;
            jacobian.m[2][j] += x[a].z * d;
        }
    return jacobian;
}

/* Gradients g_a = Je^-T dN_a/dxi at one point; returns det Je. */
static sb_real sbi_domain_point(int node_count, const sb_vec3 *x, const sb_real (*local_gradient)[3],
                                sb_real *gradient)
{
    sb_mat3 jacobian = sbi_domain_jacobian(node_count, x, local_gradient);
    sb_real det = sb_m3_det(jacobian);
    if (det > 0) {
        sb_mat3 inverse_transpose = sb_m3_scale((sb_real)1 / det, sb_m3_cofactor(jacobian));
        for (int a = 0; a < node_count; a++) {
            const sb_real *d = local_gradient[a];
            sb_vec3 g = sb_m3_apply(inverse_transpose, sb_v3(d[0], d[1], d[2]));
            gradient[3 * a] = g.x;
            gradient[3 * a + 1] = g.y;
            gradient[3 * a + 2] = g.z;
        }
    }
    return det;
}

/* 1 when a mid-edge node of a tet10 stands off the middle of its edge by more than rounding. */
static int sbi_domain_tet10_is_curved(const sb_vec3 *x)
{
    for (int e = 0; e < 6; e++) {
        int ends[3];
        sb_element_edge(SB_TET10, e, ends);
        sb_vec3 a = x[ends[0]], b = x[ends[1]], mid = x[ends[2]];
        sb_vec3 offset = sb_v3_sub(mid, sb_v3_scale((sb_real)0.5, sb_v3_add(a, b)));
        sb_real reach = sb_max(sb_v3_norm(sb_v3_sub(b, a)), SB_EPSILON * (sb_v3_norm(a) + sb_v3_norm(b)));
        if (sb_v3_norm(offset) > (sb_real)1e-5 * reach)
            return 1;
    }
    return 0;
}

static void sbi_domain_gather(const sb_mesh *mesh, int element, int node_count, sb_vec3 *x)
{
    const int *nodes = mesh->elements + (size_t)element * (size_t)node_count;
    for (int a = 0; a < node_count; a++)
        x[a] = mesh->nodes[nodes[a]];
}

static int sbi_domain_has_curved_side(const sb_mesh *mesh)
{
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    if (mesh->element_type != SB_TET10)
        return 0;
    for (int e = 0; e < mesh->element_count; e++) {
        sbi_domain_gather(mesh, e, 10, x);
        if (sbi_domain_tet10_is_curved(x))
            return 1;
    }
    return 0;
}

/* Fills weights and gradients of every cell; the arrays are there. */
static sb_result sbi_domain_fill(const sb_mesh *mesh, sb_quadrature_kind kind, sb_domain *domain, sb_error *error)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    sb_real local[SB_MAX_QUADRATURE_POINTS][SB_MAX_ELEMENT_NODES][3];
    int n = domain->nodes_per_cell, q = sb_element_quadrature(mesh->element_type, kind, points, weights);
    for (int p = 0; p < q; p++)
        sb_element_shape(mesh->element_type, points[p], NULL, local[p]);
    for (int e = 0; e < mesh->element_count; e++) {
        sb_vec3 x[SB_MAX_ELEMENT_NODES];
        sbi_domain_gather(mesh, e, n, x);
        for (int p = 0; p < q; p++) {
            size_t at = (size_t)e * (size_t)q + (size_t)p;
            sb_real det = sbi_domain_point(n, x, (const sb_real(*)[3])local[p], domain->gradients + at * 3 * (size_t)n);
            if (!(det > 0))
                return sbi_fail_element(error, SB_ERROR_MESH, e,
                                        "element %d is inverted or flat at integration point %d (Jacobian %g)", e, p,
                                        (double)det);
            domain->weights[at] = det * weights[p];
        }
        if (domain->single_rotation) {
            sb_real tet4_gradient[4][3], centre[3] = {(sb_real)0.25, (sb_real)0.25, (sb_real)0.25};
            sb_element_shape(SB_TET4, centre, NULL, tet4_gradient);
            if (!(sbi_domain_point(4, x, (const sb_real(*)[3])tet4_gradient,
                                   domain->corner_gradients + (size_t)e * 12) > 0))
                return sbi_fail_element(error, SB_ERROR_MESH, e, "the corners of element %d span no volume", e);
        }
    }
    return SB_OK;
}

static sb_result sbi_domain_allocate(const sb_mesh *mesh, const sb_allocator *allocator, sb_domain *domain,
                                     sb_error *error)
{
    size_t n = (size_t)domain->nodes_per_cell, q = (size_t)domain->points_per_cell;
    size_t cells = (size_t)mesh->element_count;
    if (allocator)
        domain->allocator = *allocator;
    domain->cells = (int *)sbi_alloc(allocator, cells, n * sizeof(int));
    domain->gradients = (sb_real *)sbi_alloc(allocator, cells, q * n * 3 * sizeof(sb_real));
    domain->weights = (sb_real *)sbi_alloc(allocator, cells, q * sizeof(sb_real));
    if (domain->single_rotation)
        domain->corner_gradients = (sb_real *)sbi_alloc(allocator, cells, 12 * sizeof(sb_real));
    if (!domain->cells || !domain->gradients || !domain->weights ||
        (domain->single_rotation && !domain->corner_gradients))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the integration points of %d elements",
                        mesh->element_count);
    memcpy(domain->cells, mesh->elements, cells * n * sizeof(int));
    return SB_OK;
}

SB_API sb_result sb_domain_create(const sb_mesh *mesh, sb_integration integration, int single_rotation,
                                  const sb_allocator *allocator, sb_domain *domain, sb_error *error)
{
    sb_domain made;
    sb_quadrature_kind kind = SB_QUADRATURE_STIFFNESS;
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    sb_result result;
    memset(&made, 0, sizeof made);
    if (!mesh || !domain)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_domain_create needs a mesh and a domain");
    result = sb_mesh_validate(mesh, error);
    if (result != SB_OK)
        return result;
    if (sb_element_dimension(mesh->element_type) != 3)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a body needs volume elements, the mesh has %s",
                        sb_element_name(mesh->element_type));
    if (!sbi_element_is_enabled(mesh->element_type))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "this build simulates one element type only (SB_ELEMENT), not %s",
                        sb_element_name(mesh->element_type));
    if (single_rotation && mesh->element_type != SB_TET10)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "one rotation per element is for tet10, the mesh has %s",
                        sb_element_name(mesh->element_type));
    if (integration == SB_INTEGRATION_CURVED ||
        (integration == SB_INTEGRATION_AUTO && sbi_domain_has_curved_side(mesh)))
        kind = SB_QUADRATURE_STIFFNESS_CURVED;
    made.element_type = mesh->element_type;
    made.single_rotation = single_rotation != 0;
    made.node_count = mesh->node_count;
    made.cell_count = mesh->element_count;
    made.nodes_per_cell = sb_element_node_count(mesh->element_type);
    made.points_per_cell = sb_element_quadrature(mesh->element_type, kind, points, weights);
    result = sbi_domain_allocate(mesh, allocator, &made, error);
    if (result == SB_OK)
        result = sbi_domain_fill(mesh, kind, &made, error);
    if (result != SB_OK) {
        sb_domain_free(&made);
        return result;
    }
    *domain = made;
    return SB_OK;
}

/* ---- mass ---- */

/* mass_ab = sum_q w det N_a N_b and load_a = sum_q w det N_a; returns the volume. */
static sb_real sbi_domain_integrate_mass(sb_element_type type, sb_quadrature_kind kind, const sb_vec3 *x,
                                         sb_real *mass, sb_real *load)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    sb_real shape[SB_MAX_ELEMENT_NODES], local[SB_MAX_ELEMENT_NODES][3];
    int n = sb_element_node_count(type), q = sb_element_quadrature(type, kind, points, weights);
    sb_real volume = 0;
    memset(mass, 0, (size_t)(n * n) * sizeof *mass);
    memset(load, 0, (size_t)n * sizeof *load);
    for (int p = 0; p < q; p++) {
        sb_element_shape(type, points[p], shape, local);
        sb_real w = weights[p] * sb_m3_det(sbi_domain_jacobian(n, x, (const sb_real(*)[3])local));
        volume += w;
        for (int a = 0; a < n; a++) {
            load[a] += w * shape[a];
            for (int b = 0; b < n; b++)
                mass[a * n + b] += w * shape[a] * shape[b];
        }
    }
    return volume;
}

SBI_API void sbi_element_mass(sb_element_type type, sb_mass_kind kind, const sb_vec3 *x, sb_real *mass,
                              sb_real *volume_load)
{
    sb_real load[SB_MAX_ELEMENT_NODES];
    int n = sb_element_node_count(type);
    sb_real volume = sbi_domain_integrate_mass(type, SB_QUADRATURE_MASS, x, mass, volume_load ? volume_load : load);
    if (kind == SB_MASS_REDUCED)
        sbi_domain_integrate_mass(type, SB_QUADRATURE_STIFFNESS, x, mass, load);
    if (kind == SB_MASS_LUMPED) {
        sb_real trace = 0;
        for (int a = 0; a < n; a++)
            trace += mass[a * n + a];
        for (int a = 0; a < n; a++)
            for (int b = 0; b < n; b++)
                mass[a * n + b] = a == b ? mass[a * n + a] * volume / trace : 0;
    }
}

/* ==== src/softbody/assembly.h ==== */
/* assembly: loops over integration points (energy, internal force, tangent). Floor 2, internal.
 *
 * Work is cut into chunks of neighbouring cells. Chunks that share a node get different colours; colours run one
 * after the other and the chunks of a colour in any order on any threads, so sums form in the same order whatever
 * the number of threads. Chunk size depends on the number of cells only. */
#ifndef SB_ASSEMBLY_H
#define SB_ASSEMBLY_H


typedef struct sbi_assembly {
    const sb_domain *domain;
    const sb_material *materials;  /* [material_count] */
    const int *cell_material;      /* [cell_count] index into materials */
    const sb_jobs *jobs;
    const sb_vec3 *reference;      /* [node_count] (m) */
    int unknots;                   /* 1: forces give a knotted cell one rotation. Only for linearised steps, which no
                                    * energy watches: the rule makes it jump */
    sb_real energy_unit;           /* sum of w (lambda + 2 mu) (J): energy densities are differences of numbers of the
                                    * size of the moduli, so this times epsilon is their rounding error */
    int batched;                   /* tet4 with every material corotated: the batched loops hold */
    sb_quat *rotations;            /* [cell_count][points_per_cell] warm starts of the polar rotations */
    sb_quat *saved_rotations;      /* [cell_count][points_per_cell] for sbi_assembly_restore_rotations */
    int *scatter;                  /* [cell_count][n (n + 1) / 2] matrix block of the pair (a, b), a <= b */
    int chunk_size, chunk_count;
    int colour_count;
    int *colour_start;             /* [colour_count + 1] into colour_chunks */
    int *colour_chunks;            /* [chunk_count] */
    sb_real *chunk_energy;         /* [chunk_count] (J) */
    int *chunk_bad_cell;           /* [chunk_count] first cell with an inadmissible F, or -1 */

    /* tet4 with corotated material: cells in batches of vector lanes, blocks gathered edge by edge */
    sb_real *batch_gradients;      /* [batch_count][9][SB_POLAR_LANES]: gradients of nodes 1..3 */
    sb_real *batch_quats;          /* [batch_count][4][SB_POLAR_LANES] */
    sb_real *saved_batch_quats;
    sb_real *rotated;              /* [cell_count][16]: R g_a of 4 nodes, w lambda, w mu, 0, 0 */
    int *pair_start;               /* [block_count + 1] into pairs; only blocks above the diagonal have any */
    int *pairs;                    /* [6 cell_count] 16 cell + 4 a + b */
} sbi_assembly;

/* Takes the arrays that the domain and the matrix pattern ask for from the arena (measuring or for real). */
SBI_API void sbi_assembly_layout(sbi_assembly *assembly, const sb_domain *domain, int block_count, sbi_arena *arena);
/* Fills scatter maps, chunks, colours and identity rotations. node_colours: scratch [node_count]. */
SBI_API void sbi_assembly_prepare(sbi_assembly *assembly, const sb_matrix *matrix, uint64_t *node_colours);
/* Says what each cell is made of; both arrays are borrowed. Call again when a material changes. */
SBI_API void sbi_assembly_set_materials(sbi_assembly *assembly, const sb_material *materials, int material_count,
                                        const int *cell_material);
/* Forgets the warm starts: rotations become the identity. */
SBI_API void sbi_assembly_reset_rotations(sbi_assembly *assembly);
/* Keeps the warm starts, and brings them back: a step that was undone leaves no trace, to the last bit. */
SBI_API void sbi_assembly_save_rotations(sbi_assembly *assembly);
SBI_API void sbi_assembly_restore_rotations(sbi_assembly *assembly);

/* force[node_count] (N) = internal force at displacements u (m); updates the rotations. Returns -1, or the first
 * cell whose F the material does not admit (then `force` is unusable). */
SBI_API int sbi_assembly_force(sbi_assembly *assembly, const sb_vec3 *u, sb_vec3 *force);
/* matrix = factor * tangent at u. Uses the rotations that the last sbi_assembly_force left at the same u. */
SBI_API int sbi_assembly_tangent(sbi_assembly *assembly, const sb_vec3 *u, sb_tangent_kind kind, sb_real factor,
                                 sb_matrix *matrix);
/* *energy (J) = elastic energy at u; returns -1 or the first inadmissible cell. Rotations stay as they are. */
SBI_API int sbi_assembly_energy(sbi_assembly *assembly, const sb_vec3 *u, sb_real *energy);
/* F and P at all points of a cell at u; f and p: [points_per_cell]. admissible[point] is 0 where the material does not
 * admit F (p is 0 there). */
SBI_API void sbi_assembly_points(const sbi_assembly *assembly, const sb_vec3 *u, int cell, sb_mat3 *f, sb_mat3 *p,
                                 int *admissible);

#endif /* SB_ASSEMBLY_H */

/* ==== src/softbody/assembly.c ==== */
/* assembly: loops over integration points. */

#include <string.h>

/* ---- set-up ---- */

static int sbi_assembly_chunk_size(int cell_count)
{
    int size = cell_count / 64; /* enough chunks for many threads, each long enough to be worth a task */
    size = size < 16 ? 16 : size > 256 ? 256 : size;
    return (size + SB_POLAR_LANES - 1) / SB_POLAR_LANES * SB_POLAR_LANES;
}

static size_t sbi_assembly_batch_count(const sb_domain *domain)
{
    return ((size_t)domain->cell_count + SB_POLAR_LANES - 1) / SB_POLAR_LANES;
}

/* The batched loops are for tet4; 16 cells + pair must fit an int. */
static int sbi_assembly_can_batch(const sb_domain *domain)
{
    return domain->element_type == SB_TET4 && domain->cell_count < INT32_MAX / 16 - SB_POLAR_LANES;
}

SBI_API void sbi_assembly_layout(sbi_assembly *assembly, const sb_domain *domain, int block_count, sbi_arena *arena)
{
    size_t cells = (size_t)domain->cell_count, n = (size_t)domain->nodes_per_cell;
    size_t chunks;
    assembly->domain = domain;
    assembly->chunk_size = sbi_assembly_chunk_size(domain->cell_count);
    assembly->chunk_count = (domain->cell_count - 1) / assembly->chunk_size + 1;
    chunks = (size_t)assembly->chunk_count;
    assembly->rotations =
        (sb_quat *)sbi_arena_take(arena, cells, (size_t)domain->points_per_cell * sizeof(sb_quat));
    assembly->saved_rotations =
        (sb_quat *)sbi_arena_take(arena, cells, (size_t)domain->points_per_cell * sizeof(sb_quat));
    assembly->scatter = (int *)sbi_arena_take(arena, cells, n * (n + 1) / 2 * sizeof(int));
    assembly->colour_start = (int *)sbi_arena_take(arena, chunks + 1, sizeof(int));
    assembly->colour_chunks = (int *)sbi_arena_take(arena, chunks, sizeof(int));
    assembly->chunk_energy = (sb_real *)sbi_arena_take(arena, chunks, sizeof(sb_real));
    assembly->chunk_bad_cell = (int *)sbi_arena_take(arena, chunks, sizeof(int));
    if (sbi_assembly_can_batch(domain)) {
        size_t batches = sbi_assembly_batch_count(domain);
        assembly->batch_gradients = (sb_real *)sbi_arena_take(arena, batches, 9 * SB_POLAR_LANES * sizeof(sb_real));
        assembly->batch_quats = (sb_real *)sbi_arena_take(arena, batches, 4 * SB_POLAR_LANES * sizeof(sb_real));
        assembly->saved_batch_quats =
            (sb_real *)sbi_arena_take(arena, batches, 4 * SB_POLAR_LANES * sizeof(sb_real));
        assembly->rotated = (sb_real *)sbi_arena_take(arena, batches * SB_POLAR_LANES, 16 * sizeof(sb_real));
        assembly->pair_start = (int *)sbi_arena_take(arena, (size_t)block_count + 1, sizeof(int));
        assembly->pairs = (int *)sbi_arena_take(arena, cells, 6 * sizeof(int));
    }
}

static int sbi_assembly_chunk_end(const sbi_assembly *assembly, int chunk)
{
    int begin = chunk * assembly->chunk_size;
    return begin + sbi_min_int(assembly->chunk_size, assembly->domain->cell_count - begin);
}

/* Colour of a chunk: the first that none of its nodes has; nodes remember theirs as bits. Beyond 63 colours (one
 * node shared by very many cells) each chunk gets a colour of its own. */
static int sbi_assembly_colour_chunk(const sbi_assembly *assembly, int chunk, uint64_t *node_colours, int *next)
{
    const sb_domain *domain = assembly->domain;
    size_t n = (size_t)domain->nodes_per_cell;
    const int *first = domain->cells + (size_t)(chunk * assembly->chunk_size) * n;
    const int *end = domain->cells + (size_t)sbi_assembly_chunk_end(assembly, chunk) * n;
    uint64_t taken = 0;
    int colour = 0;
    for (const int *node = first; node < end; node++)
        taken |= node_colours[*node];
    while (colour < 63 && (taken >> colour & 1))
        colour++;
    if (colour == 63) {
        *next = *next < 63 ? 63 : *next;
        return (*next)++;
    }
    for (const int *node = first; node < end; node++)
        node_colours[*node] |= (uint64_t)1 << colour;
    if (colour + 1 > *next)
        *next = colour + 1;
    return colour;
}

static void sbi_assembly_colour(sbi_assembly *assembly, uint64_t *node_colours)
{
    int *colour_of = assembly->chunk_bad_cell; /* free until the first loop runs */
    int position = 0;
    assembly->colour_count = 0;
    memset(node_colours, 0, (size_t)assembly->domain->node_count * sizeof *node_colours);
    for (int c = 0; c < assembly->chunk_count; c++)
        colour_of[c] = sbi_assembly_colour_chunk(assembly, c, node_colours, &assembly->colour_count);
    for (int colour = 0; colour < assembly->colour_count; colour++) {
        assembly->colour_start[colour] = position;
        for (int c = 0; c < assembly->chunk_count; c++)
            if (colour_of[c] == colour)
                assembly->colour_chunks[position++] = c;
    }
    assembly->colour_start[assembly->colour_count] = position;
}

static void sbi_assembly_map_blocks(sbi_assembly *assembly, const sb_matrix *matrix)
{
    const sb_domain *domain = assembly->domain;
    int n = domain->nodes_per_cell, *out = assembly->scatter;
    for (int e = 0; e < domain->cell_count; e++) {
        const int *cell = domain->cells + (size_t)e * (size_t)n;
        for (int a = 0; a < n; a++)
            for (int b = a; b < n; b++)
                *out++ = sb_matrix_find(matrix, cell[a], cell[b]);
    }
}

/* Lists for every block above the diagonal which cells and local pairs add to it, in cell order. */
static void sbi_assembly_list_pairs(sbi_assembly *assembly, const sb_matrix *matrix)
{
    const sb_domain *domain = assembly->domain;
    int *start = assembly->pair_start;
    memset(start, 0, ((size_t)matrix->block_count + 1) * sizeof *start);
    for (int pass = 0; pass < 2; pass++) {
        for (int e = 0; e < domain->cell_count; e++) {
            const int *cell = domain->cells + 4 * (size_t)e, *block = assembly->scatter + 10 * (size_t)e;
            for (int a = 0; a < 4; a++)
                for (int b = a; b < 4; b++, block++) {
                    int flip = cell[a] > cell[b], at = flip ? matrix->transpose[*block] : *block;
                    if (a == b)
                        continue;
                    if (pass == 0)
                        start[at]++;
                    else
                        assembly->pairs[start[at]++] = 16 * e + (flip ? 4 * b + a : 4 * a + b);
                }
        }
        for (int i = 0, sum = 0; pass == 0 && i <= matrix->block_count; i++) {
            int count = start[i];
            start[i] = sum;
            sum += count;
        }
    }
    memmove(start + 1, start, (size_t)matrix->block_count * sizeof *start);
    start[0] = 0;
}

static void sbi_assembly_fill_batches(sbi_assembly *assembly)
{
    const sb_domain *domain = assembly->domain;
    size_t batches = sbi_assembly_batch_count(domain);
    memset(assembly->batch_gradients, 0, batches * 9 * SB_POLAR_LANES * sizeof(sb_real));
    memset(assembly->rotated, 0, batches * SB_POLAR_LANES * 16 * sizeof(sb_real));
    for (int e = 0; e < domain->cell_count; e++) {
        sb_real *batch = assembly->batch_gradients + (size_t)(e / SB_POLAR_LANES) * 9 * SB_POLAR_LANES + e % SB_POLAR_LANES;
        for (int k = 0; k < 9; k++)
            batch[k * SB_POLAR_LANES] = domain->gradients[12 * (size_t)e + 3 + (size_t)k];
    }
}

SBI_API void sbi_assembly_reset_rotations(sbi_assembly *assembly)
{
    const sb_domain *domain = assembly->domain;
    size_t count = (size_t)domain->cell_count * (size_t)domain->points_per_cell;
    for (size_t i = 0; i < count; i++)
        assembly->rotations[i] = sb_quat_identity();
    if (sbi_assembly_can_batch(domain))
        for (size_t i = 0; i < sbi_assembly_batch_count(domain) * 4 * SB_POLAR_LANES; i++)
            assembly->batch_quats[i] = (i / SB_POLAR_LANES) % 4 == 0 ? (sb_real)1 : (sb_real)0;
}

/* Copies the warm starts one way or the other. */
static void sbi_assembly_copy_rotations(sbi_assembly *assembly, int restore)
{
    const sb_domain *domain = assembly->domain;
    size_t bytes = (size_t)domain->cell_count * (size_t)domain->points_per_cell * sizeof(sb_quat);
    size_t batch_bytes = sbi_assembly_batch_count(domain) * 4 * SB_POLAR_LANES * sizeof(sb_real);
    if (assembly->batched)
        memcpy(restore ? assembly->batch_quats : assembly->saved_batch_quats,
               restore ? assembly->saved_batch_quats : assembly->batch_quats, batch_bytes);
    else
        memcpy(restore ? assembly->rotations : assembly->saved_rotations,
               restore ? assembly->saved_rotations : assembly->rotations, bytes);
}

SBI_API void sbi_assembly_save_rotations(sbi_assembly *assembly) { sbi_assembly_copy_rotations(assembly, 0); }
SBI_API void sbi_assembly_restore_rotations(sbi_assembly *assembly) { sbi_assembly_copy_rotations(assembly, 1); }

SBI_API void sbi_assembly_prepare(sbi_assembly *assembly, const sb_matrix *matrix, uint64_t *node_colours)
{
    sbi_assembly_colour(assembly, node_colours);
    sbi_assembly_map_blocks(assembly, matrix);
    if (sbi_assembly_can_batch(assembly->domain)) {
        sbi_assembly_list_pairs(assembly, matrix);
        sbi_assembly_fill_batches(assembly);
    }
    sbi_assembly_reset_rotations(assembly);
}

/* ---- chunks on threads ---- */

typedef enum sbi_assembly_work { SBI_WORK_FORCE, SBI_WORK_TANGENT, SBI_WORK_ENERGY } sbi_assembly_work;

typedef struct sbi_assembly_job {
    sbi_assembly *assembly;
    sbi_assembly_work work;
    const int *chunks;          /* of the running colour */
    const sb_vec3 *u;
    sb_vec3 *force;
    sb_matrix *matrix;
    sb_tangent_kind kind;
    sb_real factor;
} sbi_assembly_job;

static void sbi_assembly_chunk(void *user, int index);

/* Runs all chunks, colour by colour; the first bad cell or -1. */
static int sbi_assembly_run(sbi_assembly_job *job)
{
    sbi_assembly *assembly = job->assembly;
    for (int colour = 0; colour < assembly->colour_count; colour++) {
        int first = assembly->colour_start[colour];
        job->chunks = assembly->colour_chunks + first;
        sbi_run(assembly->jobs, sbi_assembly_chunk, job, assembly->colour_start[colour + 1] - first);
    }
    for (int c = 0; c < assembly->chunk_count; c++)
        if (assembly->chunk_bad_cell[c] >= 0)
            return assembly->chunk_bad_cell[c];
    return -1;
}

/* ---- one cell: gather, deformation gradient ---- */

SBI_FORCE_INLINE void sbi_cell_gather(const int *cell, const sb_vec3 *u, const int n, sb_real (*local)[3])
{
    for (int a = 0; a < n; a++) {
        local[a][0] = u[cell[a]].x;
        local[a][1] = u[cell[a]].y;
        local[a][2] = u[cell[a]].z;
    }
}

/* F = I + sum_a u_a g_a^T: displacements, not positions, so that rest is exact wherever the mesh lies. */
SBI_FORCE_INLINE sb_mat3 sbi_cell_deformation(const sb_real (*u)[3], const sb_real *gradients, const int n)
{
    sb_mat3 f = sb_m3_identity();
    for (int a = 0; a < n; a++)
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                f.m[i][j] += u[a][i] * gradients[3 * a + j];
    return f;
}

/* Deformation gradients of all points of a cell. */
SBI_FORCE_INLINE void sbi_cell_deformations(const sb_domain *domain, int e, const sb_vec3 *u, const int n, const int q,
                                            sb_mat3 *f)
{
    const sb_real *gradients = domain->gradients + (size_t)e * (size_t)q * 3 * (size_t)n;
    sb_real local[SB_MAX_ELEMENT_NODES][3];
    sbi_cell_gather(domain->cells + (size_t)e * (size_t)n, u, n, local);
    for (int p = 0; p < q; p++)
        f[p] = sbi_cell_deformation((const sb_real(*)[3])local, gradients + p * 3 * n, n);
}

/* Rotation of a single-rotation cell from its four corners, which are its first four nodes. */
static sb_quat sbi_cell_corner_rotation(const sb_domain *domain, int e, const sb_vec3 *u, sb_quat start)
{
    sb_real local[4][3];
    sbi_cell_gather(domain->cells + (size_t)e * (size_t)domain->nodes_per_cell, u, 4, local);
    return sb_m3_polar(sbi_cell_deformation((const sb_real(*)[3])local, domain->corner_gradients + 12 * (size_t)e, 4),
                       start);
}

/* 1 when the rotations of a cell's points differ by more than 120 degrees somewhere. */
static int sbi_cell_is_twisted(const sb_quat *rotation, int q)
{
    const sb_real cos_half_angle = (sb_real)0.5;
    for (int i = 1; i < q; i++)
        for (int j = 0; j < i; j++)
            if (sb_abs(sb_quat_dot(rotation[i], rotation[j])) < cos_half_angle)
                return 1;
    return 0;
}

/* 1 when the element map is inside out at a node, where no integration point sees it. */
static int sbi_cell_is_folded(const sbi_assembly *assembly, int e, const sb_vec3 *u)
{
    const sb_domain *domain = assembly->domain;
    int n = domain->nodes_per_cell;
    const int *cell = domain->cells + (size_t)e * (size_t)n;
    for (int k = 0; k < n; k++) {
        sb_real xi[3] = {0, 0, 0}, gradient[SB_MAX_ELEMENT_NODES][3];
        sb_vec3 column[3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
        sb_element_node_point(domain->element_type, k, xi);
        sb_element_shape(domain->element_type, xi, NULL, gradient);
        for (int a = 0; a < n; a++) {
            sb_vec3 x = sb_v3_add(assembly->reference[cell[a]], u[cell[a]]);
            for (int j = 0; j < 3; j++)
                column[j] = sb_v3_madd(column[j], gradient[a][j], x);
        }
        if (!(sb_v3_dot(column[0], sb_v3_cross(column[1], column[2])) > 0))
            return 1;
    }
    return 0;
}

/* Polar rotation of the mean deformation gradient of a cell. */
static sb_quat sbi_cell_mean_rotation(const sb_mat3 *f, const sb_real *weights, int q, sb_quat start)
{
    sb_mat3 sum = sb_m3_zero();
    for (int p = 0; p < q; p++)
        sum = sb_m3_add(sum, sb_m3_scale(weights[p], f[p]));
    return sb_m3_polar(sum, start);
}

/* Updates the rotations of a cell of corotated material. Returns 1 when all points share one: by choice (single), or
 * because the cell is knotted. That is a state into which violence drives quadratic elements: folded where no point
 * sees it, the points so far turned against each other that their forces balance. One rotation has one rest shape, so
 * the cell comes undone. */
static int sbi_cell_rotate(const sbi_assembly *assembly, int e, const sb_vec3 *u, const sb_mat3 *f, int q, int single,
                           sb_quat *rotation)
{
    const sb_domain *domain = assembly->domain;
    sb_quat shared;
    if (single) {
        shared = sbi_cell_corner_rotation(domain, e, u, rotation[0]);
    } else {
        for (int p = 0; p < q; p++)
            rotation[p] = sb_m3_polar(f[p], rotation[p]);
        if (!assembly->unknots || !sbi_cell_is_twisted(rotation, q) || !sbi_cell_is_folded(assembly, e, u))
            return 0;
        shared = sbi_cell_mean_rotation(f, domain->weights + (size_t)e * (size_t)q, q, rotation[0]);
    }
    for (int p = 0; p < q; p++)
        rotation[p] = shared;
    return 1;
}

static int sbi_cell_is_corotated(const sb_material *material)
{
    return material->model == SB_COROTATED || material->model == SB_COROTATED_INVERTIBLE;
}

/* Corotated stress about a given rotation: P = R (lambda tr(e) I + 2 mu e), e = sym(R^T F) - I; *energy too. */
static sb_mat3 sbi_cell_rotated_stress(const sb_material *material, sb_mat3 f, sb_mat3 r, sb_real *energy)
{
    sb_mat3 b = sb_m3_tmul(r, f);
    sb_mat3 strain = sb_m3_sub(sb_m3_scale((sb_real)0.5, sb_m3_add(b, sb_m3_transpose(b))), sb_m3_identity());
    sb_real trace = sb_m3_trace(strain);
    sb_mat3 stress = sb_m3_scale(2 * material->mu, strain);
    for (int i = 0; i < 3; i++)
        stress.m[i][i] += material->lambda * trace;
    *energy = (sb_real)0.5 * sb_m3_ddot(stress, strain);
    return sb_m3_mul(r, stress);
}

/* ---- force ---- */

/* Stresses of all points of a cell; 0 when one has an inadmissible F: its stress is 0 then, and its flag (flags may
 * be NULL). */
SBI_FORCE_INLINE int sbi_cell_stresses(const sbi_assembly *assembly, const sb_material *material, int e, const sb_vec3 *u,
                                       const sb_mat3 *f, const int q, const int single, sb_quat *rotation,
                                       sb_mat3 *stress, int *flags)
{
    int corotated = sbi_cell_is_corotated(material), admissible = 1;
    int shared = corotated && sbi_cell_rotate(assembly, e, u, f, q, single, rotation);
    for (int p = 0; p < q; p++) {
        sb_real energy;
        int good = 1;
        stress[p] = sb_m3_zero();
        if (shared || material->model == SB_COROTATED)
            stress[p] = sbi_cell_rotated_stress(material, f[p], sb_quat_to_mat3(rotation[p]), &energy);
        else
            good = sb_material_stress(material, &f[p], &rotation[p], &stress[p]);
        admissible &= good;
        if (flags)
            flags[p] = good;
    }
    return admissible;
}

SBI_FORCE_INLINE int sbi_chunk_force(const sbi_assembly_job *job, int begin, int end, const int n, const int q,
                                     const int single)
{
    const sbi_assembly *assembly = job->assembly;
    const sb_domain *domain = assembly->domain;
    int bad = -1;
    for (int e = begin; e < end; e++) {
        const int *cell = domain->cells + (size_t)e * (size_t)n;
        const sb_material *material = assembly->materials + assembly->cell_material[e];
        sb_quat *rotation = assembly->rotations + (size_t)e * (size_t)q;
        sb_mat3 f[SB_MAX_QUADRATURE_POINTS], stress[SB_MAX_QUADRATURE_POINTS];
        sb_real force[SB_MAX_ELEMENT_NODES][3];
        sbi_cell_deformations(domain, e, job->u, n, q, f);
        if (!sbi_cell_stresses(assembly, material, e, job->u, f, q, single, rotation, stress, NULL) && bad < 0)
            bad = e;
        for (int a = 0; a < n; a++)
            force[a][0] = force[a][1] = force[a][2] = 0;
        for (int p = 0; p < q; p++) {
            size_t at = (size_t)e * (size_t)q + (size_t)p;
            const sb_real *g = domain->gradients + at * 3 * (size_t)n;
            sb_mat3 s = sb_m3_scale(domain->weights[at], stress[p]);
            for (int a = 0; a < n; a++)
                for (int i = 0; i < 3; i++)
                    force[a][i] += s.m[i][0] * g[3 * a] + s.m[i][1] * g[3 * a + 1] + s.m[i][2] * g[3 * a + 2];
        }
        for (int a = 0; a < n; a++) {
            job->force[cell[a]].x += force[a][0];
            job->force[cell[a]].y += force[a][1];
            job->force[cell[a]].z += force[a][2];
        }
    }
    return bad;
}

/* ---- energy ---- */

/* Elastic energy of a cell; 0 when one of its points has an inadmissible F. */
SBI_FORCE_INLINE int sbi_cell_energy(const sbi_assembly *assembly, const sb_material *material, int e, const sb_vec3 *u,
                                     const sb_mat3 *f, const int q, const int single, const sb_quat *start,
                                     sb_real *sum)
{
    sb_quat rotation[SB_MAX_QUADRATURE_POINTS];
    int shared;
    for (int p = 0; p < q; p++)
        rotation[p] = start[p];
    shared = sbi_cell_is_corotated(material) && sbi_cell_rotate(assembly, e, u, f, q, single, rotation);
    for (int p = 0; p < q; p++) {
        sb_real density = 0;
        if (shared || material->model == SB_COROTATED)
            sbi_cell_rotated_stress(material, f[p], sb_quat_to_mat3(rotation[p]), &density);
        else if (!sb_material_energy(material, &f[p], &rotation[p], &density))
            return 0;
        *sum += assembly->domain->weights[(size_t)e * (size_t)q + (size_t)p] * density;
    }
    return 1;
}

SBI_FORCE_INLINE int sbi_chunk_energy(const sbi_assembly_job *job, int begin, int end, const int n, const int q,
                                      const int single, sb_real *sum)
{
    const sbi_assembly *assembly = job->assembly;
    *sum = 0;
    for (int e = begin; e < end; e++) {
        const sb_material *material = assembly->materials + assembly->cell_material[e];
        sb_mat3 f[SB_MAX_QUADRATURE_POINTS];
        sbi_cell_deformations(assembly->domain, e, job->u, n, q, f);
        if (!sbi_cell_energy(assembly, material, e, job->u, f, q, single,
                             assembly->rotations + (size_t)e * (size_t)q, sum))
            return e;
    }
    return -1;
}

/* ---- tangent ---- */

/* Tangent blocks of a cell while they are summed: entry (i, k) of block (a, b) is at [(9 a + 3 i + k) n + b]. The
 * node b runs fastest, so that the loops over it become vector instructions; blocks below the diagonal are summed
 * along because that costs less than leaving them out. */
typedef sb_real sbi_cell_blocks[SB_MAX_ELEMENT_NODES * 9 * SB_MAX_ELEMENT_NODES];

/* Adds the blocks (a, b >= a) of a cell to the matrix, and their transposes below the diagonal. */
SBI_FORCE_INLINE void sbi_cell_scatter(sb_matrix *matrix, const int *at, const sb_real *blocks, const int n)
{
    for (int a = 0; a < n; a++)
        for (int b = a; b < n; b++, at++) {
            sb_real *upper = matrix->blocks[*at], *lower = matrix->blocks[matrix->transpose[*at]];
            for (int i = 0; i < 3; i++)
                for (int k = 0; k < 3; k++) {
                    sb_real value = blocks[(9 * a + 3 * i + k) * n + b];
                    upper[3 * i + k] += value;
                    if (a != b)
                        lower[3 * k + i] += value;
                }
        }
}

/* blocks += w (lambda h_a h_b^T + mu h_b h_a^T + mu h_a.h_b I) with h = R g (rotated-gradient identity). */
SBI_FORCE_INLINE void sbi_cell_add_rotated(sb_mat3 r, const sb_real *g, sb_real lambda, sb_real mu, const int n,
                                           sb_real *SB_RESTRICT blocks)
{
    sb_real h[3][SB_MAX_ELEMENT_NODES], dot[SB_MAX_ELEMENT_NODES];
    for (int a = 0; a < n; a++)
        for (int i = 0; i < 3; i++)
            h[i][a] = r.m[i][0] * g[3 * a] + r.m[i][1] * g[3 * a + 1] + r.m[i][2] * g[3 * a + 2];
    for (int a = 0; a < n; a++) {
        sb_real l[3] = {lambda * h[0][a], lambda * h[1][a], lambda * h[2][a]};
        sb_real m[3] = {mu * h[0][a], mu * h[1][a], mu * h[2][a]};
        for (int b = 0; b < n; b++)
            dot[b] = m[0] * h[0][b] + m[1] * h[1][b] + m[2] * h[2][b];
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++) {
                sb_real *SB_RESTRICT out = blocks + (9 * a + 3 * i + k) * n;
                for (int b = 0; b < n; b++)
                    out[b] += l[i] * h[k][b] + m[k] * h[i][b] + (i == k ? dot[b] : (sb_real)0);
            }
    }
}

/* blocks += w g_a . A . g_b with A = dP/dF, A[9 (3 i + j) + 3 k + l] = dP_ij / dF_kl. */
SBI_FORCE_INLINE void sbi_cell_add_tangent(const sb_real *tangent, const sb_real *g, sb_real w, const int n,
                                           sb_real *SB_RESTRICT blocks)
{
    sb_real by_axis[3][SB_MAX_ELEMENT_NODES];
    for (int b = 0; b < n; b++)
        for (int l = 0; l < 3; l++)
            by_axis[l][b] = g[3 * b + l];
    for (int a = 0; a < n; a++) {
        sb_real t[3][9]; /* t[i][kl] = w sum_j g_a,j A_ijkl */
        for (int i = 0; i < 3; i++)
            for (int kl = 0; kl < 9; kl++)
                t[i][kl] = w * (g[3 * a] * tangent[27 * i + kl] + g[3 * a + 1] * tangent[27 * i + 9 + kl] +
                                g[3 * a + 2] * tangent[27 * i + 18 + kl]);
        for (int i = 0; i < 3; i++)
            for (int k = 0; k < 3; k++) {
                sb_real *SB_RESTRICT out = blocks + (9 * a + 3 * i + k) * n;
                for (int b = 0; b < n; b++)
                    out[b] += t[i][3 * k] * by_axis[0][b] + t[i][3 * k + 1] * by_axis[1][b] +
                              t[i][3 * k + 2] * by_axis[2][b];
            }
    }
}

/* 1 when R C R^T is the tangent asked for, so that rotated gradients do. */
static int sbi_assembly_is_rotated(const sb_material *material, sb_tangent_kind kind)
{
    return material->model == SB_LINEAR || (sbi_cell_is_corotated(material) && kind == SB_TANGENT_QUASI);
}

/* Sums the tangent blocks of a cell; 0 when a point has an inadmissible F. */
SBI_FORCE_INLINE int sbi_cell_tangent(const sbi_assembly_job *job, int e, const int n, const int q, const int single,
                                      sb_real *blocks)
{
    const sbi_assembly *assembly = job->assembly;
    const sb_domain *domain = assembly->domain;
    const sb_material *material = assembly->materials + assembly->cell_material[e];
    const int rotated = single || sbi_assembly_is_rotated(material, job->kind);
    const sb_quat *rotation = assembly->rotations + (size_t)e * (size_t)q;
    sb_mat3 f[SB_MAX_QUADRATURE_POINTS];
    if (!rotated)
        sbi_cell_deformations(domain, e, job->u, n, q, f);
    for (int p = 0; p < q; p++) {
        size_t point = (size_t)e * (size_t)q + (size_t)p;
        const sb_real *g = domain->gradients + point * 3 * (size_t)n;
        sb_real w = domain->weights[point] * job->factor, tangent[81];
        sb_quat start = rotation[p];
        if (rotated) {
            sb_mat3 r = material->model == SB_LINEAR ? sb_m3_identity() : sb_quat_to_mat3(start);
            sbi_cell_add_rotated(r, g, w * material->lambda, w * material->mu, n, blocks);
        } else {
            if (!sb_material_tangent(material, &f[p], &start, job->kind, tangent))
                return 0;
            sbi_cell_add_tangent(tangent, g, w, n, blocks);
        }
    }
    return 1;
}

SBI_FORCE_INLINE int sbi_chunk_tangent(const sbi_assembly_job *job, int begin, int end, const int n, const int q,
                                       const int single)
{
    const int pair_count = n * (n + 1) / 2;
    int bad = -1;
    for (int e = begin; e < end; e++) {
        const int *at = job->assembly->scatter + (size_t)e * (size_t)pair_count;
        sbi_cell_blocks blocks;
        memset(blocks, 0, (size_t)(9 * n * n) * sizeof blocks[0]);
        if (!sbi_cell_tangent(job, e, n, q, single, blocks) && bad < 0)
            bad = e;
        sbi_cell_scatter(job->matrix, at, blocks, n);
    }
    return bad;
}

/* ---- tet4 with corotated material: eight cells at a time, blocks gathered edge by edge ---- */

/* Differences u_a - u_0 of nodes a = 1..3 of the cells of a batch, component by component. */
static void sbi_batch_gather(const sb_domain *domain, int batch, const sb_vec3 *u, sb_real (*d)[SB_POLAR_LANES])
{
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        int e = sbi_min_int(batch * SB_POLAR_LANES + l, domain->cell_count - 1);
        const int *cell = domain->cells + 4 * (size_t)e;
        sb_vec3 origin = u[cell[0]];
        for (int a = 0; a < 3; a++) {
            sb_vec3 v = u[cell[a + 1]];
            d[3 * a][l] = v.x - origin.x;
            d[3 * a + 1][l] = v.y - origin.y;
            d[3 * a + 2][l] = v.z - origin.z;
        }
    }
}

/* out[3 a + i] = sum_j m[3 i + j] g[3 a + j]: the 3x3 matrix m applied to three gradients, lane by lane. */
SBI_FORCE_INLINE void sbi_batch_apply(const sb_real (*m)[SB_POLAR_LANES], const sb_real (*g)[SB_POLAR_LANES],
                                      sb_real (*out)[SB_POLAR_LANES])
{
    for (int a = 0; a < 3; a++)
        for (int i = 0; i < 3; i++)
            for (int l = 0; l < SB_POLAR_LANES; l++)
                out[3 * a + i][l] = m[3 * i][l] * g[3 * a][l] + m[3 * i + 1][l] * g[3 * a + 1][l] +
                                    m[3 * i + 2][l] * g[3 * a + 2][l];
}

/* w lambda and w mu of the cells of a batch. */
static void sbi_batch_moduli(const sbi_assembly *assembly, int batch, sb_real *lambda, sb_real *mu)
{
    const sb_domain *domain = assembly->domain;
    for (int l = 0; l < SB_POLAR_LANES; l++) {
        int e = sbi_min_int(batch * SB_POLAR_LANES + l, domain->cell_count - 1);
        const sb_material *material = assembly->materials + assembly->cell_material[e];
        lambda[l] = domain->weights[e] * material->lambda;
        mu[l] = domain->weights[e] * material->mu;
    }
}

/* Stress w P = 2 w mu (F - R) + w lambda (tr(R^T F) - 3) R, in place of F. */
SBI_FORCE_INLINE void sbi_batch_stress(const sb_real (*r)[SB_POLAR_LANES], const sb_real *lambda, const sb_real *mu,
                                       sb_real (*f)[SB_POLAR_LANES])
{
    sb_real trace[SB_POLAR_LANES];
    for (int l = 0; l < SB_POLAR_LANES; l++)
        trace[l] = -3;
    for (int k = 0; k < 9; k++)
        for (int l = 0; l < SB_POLAR_LANES; l++)
            trace[l] += r[k][l] * f[k][l];
    for (int k = 0; k < 9; k++)
        for (int l = 0; l < SB_POLAR_LANES; l++)
            f[k][l] = 2 * mu[l] * (f[k][l] - r[k][l]) + lambda[l] * trace[l] * r[k][l];
}

/* Adds the forces of a batch to its nodes and stores the rotated gradients for the tangent. */
static void sbi_batch_scatter(sbi_assembly_job *job, int batch, const sb_real (*f)[SB_POLAR_LANES],
                              const sb_real (*h)[SB_POLAR_LANES], const sb_real *lambda, const sb_real *mu)
{
    const sb_domain *domain = job->assembly->domain;
    int count = sbi_min_int(SB_POLAR_LANES, domain->cell_count - batch * SB_POLAR_LANES);
    for (int l = 0; l < count; l++) {
        size_t e = (size_t)(batch * SB_POLAR_LANES + l);
        const int *cell = domain->cells + 4 * e;
        sb_real *out = job->assembly->rotated + 16 * e;
        sb_vec3 *origin = job->force + cell[0];
        for (int i = 0; i < 3; i++)
            out[i] = -(h[i][l] + h[3 + i][l] + h[6 + i][l]);
        for (int k = 0; k < 9; k++)
            out[3 + k] = h[k][l];
        out[12] = lambda[l];
        out[13] = mu[l];
        origin->x -= f[0][l] + f[3][l] + f[6][l];
        origin->y -= f[1][l] + f[4][l] + f[7][l];
        origin->z -= f[2][l] + f[5][l] + f[8][l];
        for (int a = 0; a < 3; a++) {
            sb_vec3 *node = job->force + cell[a + 1];
            node->x += f[3 * a][l];
            node->y += f[3 * a + 1][l];
            node->z += f[3 * a + 2][l];
        }
    }
}

static void sbi_batch_force(sbi_assembly_job *job, int begin, int end)
{
    sbi_assembly *assembly = job->assembly;
    for (int batch = begin / SB_POLAR_LANES; batch * SB_POLAR_LANES < end; batch++) {
        const sb_real(*g)[SB_POLAR_LANES] = (const sb_real(*)[SB_POLAR_LANES])(assembly->batch_gradients +
                                                                     (size_t)batch * 9 * SB_POLAR_LANES);
        sb_real(*quats)[SB_POLAR_LANES] = (sb_real(*)[SB_POLAR_LANES])(assembly->batch_quats + (size_t)batch * 4 * SB_POLAR_LANES);
        sb_real d[9][SB_POLAR_LANES], f[9][SB_POLAR_LANES], r[9][SB_POLAR_LANES], h[9][SB_POLAR_LANES];
        sb_real lambda[SB_POLAR_LANES], mu[SB_POLAR_LANES];
        sbi_batch_gather(assembly->domain, batch, job->u, d);
        sbi_batch_moduli(assembly, batch, lambda, mu);
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                for (int l = 0; l < SB_POLAR_LANES; l++)
                    f[3 * i + j][l] = (i == j ? (sb_real)1 : (sb_real)0) + d[i][l] * g[j][l] +
                                      d[3 + i][l] * g[3 + j][l] + d[6 + i][l] * g[6 + j][l];
        sb_polar_batch(f, quats, r);
        sbi_batch_stress((const sb_real(*)[SB_POLAR_LANES])r, lambda, mu, f);
        sbi_batch_apply((const sb_real(*)[SB_POLAR_LANES])r, g, h);
        sbi_batch_apply((const sb_real(*)[SB_POLAR_LANES])f, g, d);
        sbi_batch_scatter(job, batch, (const sb_real(*)[SB_POLAR_LANES])d, (const sb_real(*)[SB_POLAR_LANES])h, lambda, mu);
    }
}

enum { SBI_ROWS_PER_TASK = 128 };

/* Blocks above the diagonal in some rows, and their transposes below it:
 * K_ij = sum over the cells of edge ij of w (lambda h_a h_b^T + mu h_b h_a^T + mu h_a.h_b I). */
static void sbi_edge_rows(void *user, int index)
{
    const sbi_assembly_job *job = (const sbi_assembly_job *)user;
    const sbi_assembly *assembly = job->assembly;
    sb_matrix *matrix = job->matrix;
    int begin = index * SBI_ROWS_PER_TASK;
    int end = begin + sbi_min_int(SBI_ROWS_PER_TASK, matrix->row_count - begin);
    for (int row = begin; row < end; row++)
        for (int k = matrix->diagonal[row] + 1; k < matrix->row_start[row + 1]; k++) {
            sb_real l[9] = {0}, m[9] = {0}; /* sums of w lambda h_a h_b^T and w mu h_a h_b^T */
            sb_real *upper = matrix->blocks[k], *lower = matrix->blocks[matrix->transpose[k]];
            for (int p = assembly->pair_start[k]; p < assembly->pair_start[k + 1]; p++) {
                int pair = assembly->pairs[p];
                const sb_real *h = assembly->rotated + 16 * (size_t)(pair >> 4);
                const sb_real *a = h + 3 * (pair >> 2 & 3), *b = h + 3 * (pair & 3);
                for (int i = 0; i < 3; i++)
                    for (int j = 0; j < 3; j++) {
                        sb_real product = a[i] * b[j];
                        l[3 * i + j] += h[12] * product;
                        m[3 * i + j] += h[13] * product;
                    }
            }
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++) {
                    sb_real dot = i == j ? m[0] + m[4] + m[8] : (sb_real)0;
                    upper[3 * i + j] = lower[3 * j + i] = job->factor * (l[3 * i + j] + m[3 * j + i] + dot);
                }
        }
}

/* Diagonal blocks: a rigid translation costs nothing, so K_ii = - sum over j != i of K_ij. */
static void sbi_edge_diagonals(void *user, int index)
{
    const sbi_assembly_job *job = (const sbi_assembly_job *)user;
    sb_matrix *matrix = job->matrix;
    int begin = index * SBI_ROWS_PER_TASK;
    int end = begin + sbi_min_int(SBI_ROWS_PER_TASK, matrix->row_count - begin);
    for (int row = begin; row < end; row++) {
        sb_real sum[9] = {0}, *out = matrix->blocks[matrix->diagonal[row]];
        for (int k = matrix->row_start[row]; k < matrix->row_start[row + 1]; k++)
            if (k != matrix->diagonal[row])
                for (int c = 0; c < 9; c++)
                    sum[c] -= matrix->blocks[k][c];
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++)
                out[3 * i + j] = (sb_real)0.5 * (sum[3 * i + j] + sum[3 * j + i]);
    }
}

/* ---- instances per element type ---- */

#define SBI_EACH_ELEMENT(CALL)                                                                                  \
    switch (sbi_element_type_or_pinned(domain->element_type)) {                                                 \
    case SB_TET4: CALL(4, 1, 0); break;                                                                         \
    case SB_TET10:                                                                                              \
        if (domain->points_per_cell != 4) {                                                                     \
            CALL(10, domain->points_per_cell, domain->single_rotation);                                         \
        } else if (domain->single_rotation) {                                                                   \
            CALL(10, 4, 1);                                                                                     \
        } else {                                                                                                \
            CALL(10, 4, 0);                                                                                     \
        }                                                                                                       \
        break;                                                                                                  \
    case SB_HEX8: CALL(8, 8, 0); break;                                                                         \
    default: CALL(domain->nodes_per_cell, domain->points_per_cell, 0); break;                                   \
    }

static int sbi_chunk_force_any(sbi_assembly_job *job, int begin, int end)
{
    const sb_domain *domain = job->assembly->domain;
    if (SBI_ELEMENT_ENABLED(SB_TET4) && job->assembly->batched) {
        sbi_batch_force(job, begin, end);
        return -1;
    }
#define SBI_CALL(n, q, single) return sbi_chunk_force(job, begin, end, n, q, single)
    SBI_EACH_ELEMENT(SBI_CALL)
#undef SBI_CALL
    return -1;
}

static int sbi_chunk_tangent_any(const sbi_assembly_job *job, int begin, int end)
{
    const sb_domain *domain = job->assembly->domain;
#define SBI_CALL(n, q, single) return sbi_chunk_tangent(job, begin, end, n, q, single)
    SBI_EACH_ELEMENT(SBI_CALL)
#undef SBI_CALL
    return -1;
}

static int sbi_chunk_energy_any(const sbi_assembly_job *job, int begin, int end, sb_real *sum)
{
    const sb_domain *domain = job->assembly->domain;
#define SBI_CALL(n, q, single) return sbi_chunk_energy(job, begin, end, n, q, single, sum)
    SBI_EACH_ELEMENT(SBI_CALL)
#undef SBI_CALL
    return -1;
}
#undef SBI_EACH_ELEMENT

static void sbi_assembly_chunk(void *user, int index)
{
    sbi_assembly_job *job = (sbi_assembly_job *)user;
    sbi_assembly *assembly = job->assembly;
    int chunk = job->chunks[index], begin = chunk * assembly->chunk_size;
    int end = sbi_assembly_chunk_end(assembly, chunk), bad = -1;
    switch (job->work) {
    case SBI_WORK_FORCE: bad = sbi_chunk_force_any(job, begin, end); break;
    case SBI_WORK_TANGENT: bad = sbi_chunk_tangent_any(job, begin, end); break;
    case SBI_WORK_ENERGY: bad = sbi_chunk_energy_any(job, begin, end, &assembly->chunk_energy[chunk]); break;
    }
    assembly->chunk_bad_cell[chunk] = bad;
}

/* ---- entry points ---- */

SBI_API void sbi_assembly_set_materials(sbi_assembly *assembly, const sb_material *materials, int material_count,
                                        const int *cell_material)
{
    const sb_domain *domain = assembly->domain;
    size_t points = (size_t)domain->cell_count * (size_t)domain->points_per_cell;
    assembly->materials = materials;
    assembly->cell_material = cell_material;
    assembly->batched = sbi_assembly_can_batch(domain);
    assembly->energy_unit = 0;
    for (size_t p = 0; p < points; p++) {
        const sb_material *material = materials + cell_material[p / (size_t)domain->points_per_cell];
        assembly->energy_unit += domain->weights[p] * (material->lambda + 2 * material->mu);
    }
    for (int i = 0; i < material_count; i++)
        if (materials[i].model != SB_COROTATED)
            assembly->batched = 0;
}

static sbi_assembly_job sbi_assembly_make_job(sbi_assembly *assembly, sbi_assembly_work work, const sb_vec3 *u)
{
    sbi_assembly_job job;
    memset(&job, 0, sizeof job);
    job.assembly = assembly;
    job.work = work;
    job.u = u;
    job.factor = 1;
    job.kind = SB_TANGENT_EXACT;
    return job;
}

SBI_API int sbi_assembly_force(sbi_assembly *assembly, const sb_vec3 *u, sb_vec3 *force)
{
    sbi_assembly_job job = sbi_assembly_make_job(assembly, SBI_WORK_FORCE, u);
    job.force = force;
    memset(force, 0, (size_t)assembly->domain->node_count * sizeof *force);
    return sbi_assembly_run(&job);
}

SBI_API int sbi_assembly_tangent(sbi_assembly *assembly, const sb_vec3 *u, sb_tangent_kind kind, sb_real factor,
                                 sb_matrix *matrix)
{
    sbi_assembly_job job = sbi_assembly_make_job(assembly, SBI_WORK_TANGENT, u);
    job.kind = kind;
    job.factor = factor;
    job.matrix = matrix;
    if (SBI_ELEMENT_ENABLED(SB_TET4) && assembly->batched && kind == SB_TANGENT_QUASI) {
        int tasks = (matrix->row_count - 1) / SBI_ROWS_PER_TASK + 1;
        sbi_run(assembly->jobs, sbi_edge_rows, &job, tasks);
        sbi_run(assembly->jobs, sbi_edge_diagonals, &job, tasks);
        return -1;
    }
    memset(matrix->blocks, 0, (size_t)matrix->block_count * sizeof matrix->blocks[0]);
    return sbi_assembly_run(&job);
}

SBI_API int sbi_assembly_energy(sbi_assembly *assembly, const sb_vec3 *u, sb_real *energy)
{
    sbi_assembly_job job = sbi_assembly_make_job(assembly, SBI_WORK_ENERGY, u);
    int bad = sbi_assembly_run(&job);
    sb_real sum = 0;
    for (int c = 0; c < assembly->chunk_count; c++)
        sum += assembly->chunk_energy[c];
    *energy = sum;
    return bad;
}

SBI_API void sbi_assembly_points(const sbi_assembly *assembly, const sb_vec3 *u, int cell, sb_mat3 *f, sb_mat3 *p,
                                 int *admissible)
{
    const sb_domain *domain = assembly->domain;
    int q = domain->points_per_cell;
    const sb_quat *start = assembly->rotations + (size_t)cell * (size_t)q;
    sb_quat rotation[SB_MAX_QUADRATURE_POINTS];
    for (int i = 0; i < q; i++)
        rotation[i] = start[i];
    sbi_cell_deformations(domain, cell, u, domain->nodes_per_cell, q, f);
    sbi_cell_stresses(assembly, assembly->materials + assembly->cell_material[cell], cell, u, f, q,
                      domain->single_rotation, rotation, p, admissible);
}

/* ==== src/softbody/body_state.h ==== */
/* body_state: what is inside an sb_body. Floor 3, internal: body.c keeps it, step.c moves it. */
#ifndef SB_BODY_STATE_H
#define SB_BODY_STATE_H


/* What an explicit body knows of its stability; part of the state, zeros: nothing yet. */
typedef struct sbi_step_guard {
    sb_real stable_step;         /* at the last look (s) */
    int age;                     /* substeps since */
    int ledger_open;             /* 1: energy means something */
    int caution, calm;           /* plan of substeps, and calls that went well with it */
    double energy;               /* what the body has left of what it was given (J): more cannot be in its motion */
} sbi_step_guard;

struct sb_body {
    sb_allocator allocator;
    sb_jobs jobs;
    sb_clock clock;

    /* what it is made of */
    sb_domain domain;
    sb_matrix matrix;
    sb_preconditioner *precond;
    sb_pcg_workspace pcg;
    sbi_assembly assembly;
    void *memory;                /* the one block behind the arrays below and in assembly */
    int material_count;          /* one per region of the mesh */
    int *material_regions;       /* [material_count] ascending region numbers */
    sb_material *materials;      /* [material_count] */
    int *cell_material;          /* [cell_count] */
    sb_real force_unit;          /* stiffness times volume over size (N): times epsilon, rounding in the forces */
    int component_count;         /* connected parts */
    sb_index_table element_component;
    sb_index_lists node_elements;
    int *node_component;         /* [node_count], -1: no element */

    /* settings */
    sb_mass_kind mass_kind;
    sb_integrator integrator;
    sb_vec3 gravity;
    sb_real damping_mass, damping_stiffness;
    sb_real tolerance, newton_tolerance;
    int max_iterations, max_newton;
    sb_real spectral_radius;
    int max_substeps;

    /* mass */
    sb_real *lumped_mass;        /* [node_count] (kg) */
    sb_real *mass_blocks;        /* [block_count] (kg) scalar mass of each matrix block, or NULL: lumped */
    sb_real *load_mass;          /* [node_count] (kg) int rho N dV: what gravity pulls at in a static solve */

    /* supports and loads */
    unsigned char *fixed;        /* [node_count] axes as bits; unreferenced nodes always all */
    sb_vec3 *target;             /* [node_count] target displacement of fixed axes (m) */
    sb_vec3 *dead_load;          /* [node_count] forces and tractions (N) */
    int support_used;            /* blocks in the rows of nodes with fixed axes */
    int support_capacity;        /* blocks that support_blocks holds */
    sb_real (*support_blocks)[9];/* tangent rows of nodes with fixed axes, kept before they are masked */
    sb_real (*damping_blocks)[9];/* stiffness at the start of a step of several iterations, for D; or NULL */
    double (*support_grams)[36]; /* [component_count] what the supports do to rigid motions */
    sb_vec3 *component_low, *component_high; /* [component_count] bounding boxes (m) */

    /* state */
    sb_vec3 *reference;          /* [node_count] (m) */
    sb_vec3 *position, *displacement, *velocity, *acceleration;
    int acceleration_known;      /* 0: the next Newmark step solves M a = f first */
    int force_current;           /* 1: internal holds the force at displacement */
    sbi_step_guard guard;

    /* vectors of a solve, [node_count] each */
    sb_vec3 *internal;           /* internal force (N) */
    sb_vec3 *external;           /* loads of the last solve (N) */
    sb_vec3 *equilibrated;       /* loads that the last static solve ended with (N) */
    sb_vec3 *residual;           /* M a + D v + internal - external */
    sb_vec3 *rhs, *increment, *reaction;
    sb_vec3 *velocity0, *acceleration0; /* v = cv (u - start) + velocity0, a likewise */
    sb_vec3 *start;              /* displacement at the start of the step */
    sb_vec3 *saved_velocity, *saved_acceleration, *saved_reaction, *saved_external, *saved_internal;
    int saved_force_current;
    sb_vec3 *converged;          /* displacement at the last converged load increment */
    sb_vec3 *work, *work2;
};

/* Recomputes masses after a density changed. */
SBI_API void sbi_body_update_mass(sb_body *body);
/* blocks[block_count] (kg) = a mass matrix of any kind, one scalar per block of the pattern. */
SBI_API void sbi_body_mass_blocks(const sb_body *body, sb_mass_kind kind, sb_real *blocks);
/* out = M x for the body's mass matrix. */
SBI_API void sbi_body_mass_multiply(const sb_body *body, const sb_vec3 *x, sb_vec3 *out);
/* matrix += factor * M */
SBI_API void sbi_body_add_mass(sb_body *body, sb_real factor);
/* Newton iterations of a time step, SB_AUTO resolved. */
SBI_API int sbi_body_max_newton(const sb_body *body);
/* The components of `value` on the given axes (bits), of `otherwise` on the others. */
SBI_API sb_vec3 sbi_body_pick_axes(unsigned axes, sb_vec3 value, sb_vec3 otherwise);
/* position = reference + displacement */
SBI_API void sbi_body_update_positions(sb_body *body);
/* A node of the first connected part whose supports leave a rigid motion free, or -1. */
SBI_API int sbi_body_unsupported_node(const sb_body *body);

#endif /* SB_BODY_STATE_H */

/* ==== src/softbody/body.c ==== */
/* body: creation, properties, supports, loads, readings. */

#include <string.h>

#define SBI_BODY_COOKIE 0x5b0d1u

SB_API sb_body_def sb_default_body_def(void)
{
    sb_body_def def;
    memset(&def, 0, sizeof def);
    def.integration = SB_INTEGRATION_AUTO;
    def.mass = SB_MASS_LUMPED;
    def.integrator = SB_EULER;
    def.preconditioner = SB_PRECOND_AUTO;
    def.tolerance = (sb_real)1e-3;
    def.max_iterations = 500;
    def.max_newton = SB_AUTO;
    def.spectral_radius = (sb_real)0.5;
    def.max_substeps = 10000;
    def.newton_tolerance = (sb_real)1e-6;
    def.cookie = SBI_BODY_COOKIE;
    return def;
}

/* ---- creation: arguments ---- */

static sb_result sbi_body_check_settings(const sb_body_def *def, sb_error *error)
{
    if (!sb_v3_is_finite(def->gravity))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "def.gravity is not finite");
    if (!(def->damping_mass >= 0) || !(def->damping_stiffness >= 0) || !sb_is_finite(def->damping_mass) ||
        !sb_is_finite(def->damping_stiffness))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.damping_mass %g and def.damping_stiffness %g must be >= 0",
                        (double)def->damping_mass, (double)def->damping_stiffness);
    if (!(def->tolerance > 0) || !(def->tolerance < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.tolerance %g must be in (0, 1)", (double)def->tolerance);
    if (!(def->newton_tolerance > 0) || !(def->newton_tolerance < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.newton_tolerance %g must be in (0, 1)",
                        (double)def->newton_tolerance);
    if (def->max_iterations < 1 || (def->max_newton < 1 && def->max_newton != SB_AUTO))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.max_iterations %d and def.max_newton %d must be >= 1",
                        def->max_iterations, def->max_newton);
    if (def->integrator < SB_EULER || def->integrator > SB_CENTRAL_DIFFERENCE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.integrator %d is unknown", (int)def->integrator);
    if (!(def->spectral_radius >= 0) || !(def->spectral_radius <= 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.spectral_radius %g must be in [0, 1]",
                        (double)def->spectral_radius);
    if (def->max_substeps < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.max_substeps %d must be >= 1", def->max_substeps);
    if (def->integration < SB_INTEGRATION_AUTO || def->integration > SB_INTEGRATION_CURVED)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.integration %d is unknown", (int)def->integration);
    if (def->mass != SB_MASS_LUMPED && def->mass != SB_MASS_CONSISTENT && def->mass != SB_MASS_REDUCED)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.mass %d is unknown", (int)def->mass);
    if (def->allocator.alloc && !def->allocator.release)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.allocator has alloc but no release");
    if (def->integrator == SB_CENTRAL_DIFFERENCE && def->mass != SB_MASS_LUMPED)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "SB_CENTRAL_DIFFERENCE needs def.mass SB_MASS_LUMPED");
    if (def->integrator == SB_CENTRAL_DIFFERENCE && def->damping_stiffness > 0)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "SB_CENTRAL_DIFFERENCE damps with def.damping_mass, not with def.damping_stiffness %g",
                        (double)def->damping_stiffness);
    return SB_OK;
}

static sb_result sbi_body_check_material(const sb_material *material, int single_rotation, sb_error *error)
{
    sb_result result = sb_material_check(material, error);
    if (result == SB_OK && single_rotation && material->model != SB_COROTATED)
        return sbi_fail(error, SB_ERROR_MATERIAL, "one rotation per element needs the corotated material");
    return result;
}

static sb_result sbi_body_check_def(const sb_body_def *def, sb_error *error)
{
    sb_result result;
    if (def->cookie != SBI_BODY_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by sb_default_body_def");
    if (!def->mesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.mesh is NULL");
    if (def->region_material_count < 0 || (def->region_material_count > 0 && !def->region_materials))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.region_materials is NULL or its count negative");
    result = sbi_body_check_settings(def, error);
    for (int i = 0; i < def->region_material_count && result == SB_OK; i++)
        result = sbi_body_check_material(&def->region_materials[i].material, def->single_rotation, error);
    return result;
}

/* ---- creation: regions and materials ---- */

static int sbi_body_region(const sb_mesh *mesh, int element)
{
    return mesh->regions ? mesh->regions[element] : 0;
}

/* Index of a region in the ascending list, or where it would stand (then *found is 0). */
static int sbi_body_find_region(const int *regions, int count, int region, int *found)
{
    int low = 0, high = count;
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (regions[middle] < region)
            low = middle + 1;
        else
            high = middle;
    }
    *found = low < count && regions[low] == region;
    return low;
}

/* Lists the distinct regions of a mesh, ascending, in regions[capacity]; returns how many there are (counting on
 * past the capacity when it is too small, so that the caller can come back with more). */
static int sbi_body_list_regions(const sb_mesh *mesh, int *regions, int capacity)
{
    int count = 0, last = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        int region = sbi_body_region(mesh, e), found, at;
        if (e > 0 && region == last)
            continue;
        last = region;
        at = sbi_body_find_region(regions, sbi_min_int(count, capacity), region, &found);
        if (found)
            continue;
        if (count < capacity) {
            memmove(regions + at + 1, regions + at, (size_t)(count - at) * sizeof *regions);
            regions[at] = region;
        }
        count++;
    }
    return count;
}

/* Regions and materials, one material per region, and each cell's material. */
static sb_result sbi_body_make_materials(sb_body *body, const sb_body_def *def, sb_error *error)
{
    int capacity = 4, count, found;
    for (;; capacity = count) {
        sbi_free(&body->allocator, body->material_regions);
        body->material_regions = (int *)sbi_alloc(&body->allocator, (size_t)capacity, sizeof(int));
        if (!body->material_regions)
            return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d regions", capacity);
        count = sbi_body_list_regions(def->mesh, body->material_regions, capacity);
        if (count <= capacity)
            break;
    }
    body->material_count = count;
    body->materials = (sb_material *)sbi_alloc(&body->allocator, (size_t)count, sizeof(sb_material));
    body->cell_material = (int *)sbi_alloc(&body->allocator, (size_t)def->mesh->element_count, sizeof(int));
    if (!body->materials || !body->cell_material)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d materials", count);
    for (int e = 0; e < def->mesh->element_count; e++)
        body->cell_material[e] =
            sbi_body_find_region(body->material_regions, count, sbi_body_region(def->mesh, e), &found);
    for (int k = 0; k < def->region_material_count; k++) {
        for (int i = 0; i < k; i++)
            if (def->region_materials[i].region == def->region_materials[k].region)
                return sbi_fail(error, SB_ERROR_ARGUMENT, "def.region_materials names region %d twice",
                                def->region_materials[k].region);
        sbi_body_find_region(body->material_regions, count, def->region_materials[k].region, &found);
        if (!found)
            return sbi_fail(error, SB_ERROR_INDEX, "def.region_materials names region %d, which the mesh does not have",
                            def->region_materials[k].region);
    }
    for (int i = 0; i < count; i++) {
        const sb_material *material = &def->material;
        for (int k = 0; k < def->region_material_count; k++)
            if (def->region_materials[k].region == body->material_regions[i])
                material = &def->region_materials[k].material;
        sb_result result = sbi_body_check_material(material, def->single_rotation, error);
        if (result != SB_OK)
            return result;
        body->materials[i] = *material;
    }
    return SB_OK;
}

/* ---- creation: memory ---- */

/* Lays out every array of the body; walked once to measure and once to hand out. */
static void sbi_body_layout(sb_body *body, sbi_arena *arena)
{
    size_t n = (size_t)body->domain.node_count;
    sb_vec3 **vectors[] = {&body->reference, &body->position,     &body->displacement,  &body->velocity,
                           &body->target,    &body->dead_load,    &body->acceleration,  &body->internal,
                           &body->external,  &body->equilibrated, &body->residual,      &body->rhs,
                           &body->increment, &body->reaction,     &body->velocity0,     &body->acceleration0,
                           &body->start,     &body->saved_velocity, &body->saved_acceleration,
                           &body->saved_reaction, &body->saved_external, &body->saved_internal, &body->converged,
                           &body->work,      &body->work2};
    for (size_t i = 0; i < sizeof vectors / sizeof vectors[0]; i++)
        *vectors[i] = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    body->lumped_mass = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    body->load_mass = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    if (body->mass_kind != SB_MASS_LUMPED)
        body->mass_blocks = (sb_real *)sbi_arena_take(arena, (size_t)body->matrix.block_count, sizeof(sb_real));
    body->fixed = (unsigned char *)sbi_arena_take(arena, n, 1);
    body->support_grams = (double(*)[36])sbi_arena_take(arena, (size_t)body->component_count, 36 * sizeof(double));
    body->component_low = (sb_vec3 *)sbi_arena_take(arena, (size_t)body->component_count, sizeof(sb_vec3));
    body->component_high = (sb_vec3 *)sbi_arena_take(arena, (size_t)body->component_count, sizeof(sb_vec3));
    body->node_component = (int *)sbi_arena_take(arena, n, sizeof(int));
    sbi_assembly_layout(&body->assembly, &body->domain, body->matrix.block_count, arena);
}

static sb_result sbi_body_take_memory(sb_body *body, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    unsigned char *base;
    sbi_body_layout(body, &arena);
    body->memory = arena.overflow || arena.used > (size_t)-1 - 64 ? NULL
                                                                  : sbi_alloc(&body->allocator, arena.used + 64, 1);
    if (!body->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the state of %d nodes", body->domain.node_count);
    base = (unsigned char *)body->memory;
    memset(base, 0, arena.used + 64);
    arena.base = base + (64 - (size_t)((uintptr_t)base & 63));
    arena.used = 0;
    sbi_body_layout(body, &arena);
    return SB_OK;
}

/* ---- the reference shape ---- */

/* The reference mesh as others see it; borrowed arrays. */
static sb_mesh sbi_body_mesh_view(const sb_body *body)
{
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    mesh.node_count = body->domain.node_count;
    mesh.nodes = body->reference;
    mesh.element_type = body->domain.element_type;
    mesh.element_count = body->domain.cell_count;
    mesh.elements = body->domain.cells;
    return mesh;
}

/* Diagonal of the bounding box (m). */
static sb_real sbi_body_size(const sb_body *body)
{
    sb_mesh mesh = sbi_body_mesh_view(body);
    sb_vec3 low, high;
    sb_mesh_bounds(&mesh, &low, &high);
    return sb_v3_norm(sb_v3_sub(high, low));
}

/* ---- mass ---- */

static void sbi_body_gather_reference(const sb_body *body, int element, sb_vec3 *x)
{
    int n = body->domain.nodes_per_cell;
    const int *cell = body->domain.cells + (size_t)element * (size_t)n;
    for (int a = 0; a < n; a++)
        x[a] = body->reference[cell[a]];
}

/* Adds the mass of one element to the matrix blocks, both sides of the diagonal. */
static void sbi_body_add_mass_blocks(const sb_body *body, int element, const sb_real *mass, sb_real density,
                                     sb_real *blocks)
{
    int n = body->domain.nodes_per_cell;
    const int *at = body->assembly.scatter + (size_t)element * (size_t)(n * (n + 1) / 2);
    for (int a = 0; a < n; a++)
        for (int b = a; b < n; b++, at++) {
            blocks[*at] += density * mass[a * n + b];
            if (a != b)
                blocks[body->matrix.transpose[*at]] += density * mass[a * n + b];
        }
}

SBI_API void sbi_body_mass_blocks(const sb_body *body, sb_mass_kind kind, sb_real *blocks)
{
    sb_real mass[SB_MAX_ELEMENT_NODES * SB_MAX_ELEMENT_NODES];
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    memset(blocks, 0, (size_t)body->matrix.block_count * sizeof *blocks);
    for (int e = 0; e < body->domain.cell_count; e++) {
        sbi_body_gather_reference(body, e, x);
        sbi_element_mass(body->domain.element_type, kind, x, mass, NULL);
        sbi_body_add_mass_blocks(body, e, mass, body->materials[body->cell_material[e]].density, blocks);
    }
}

SBI_API void sbi_body_update_mass(sb_body *body)
{
    sb_real mass[SB_MAX_ELEMENT_NODES * SB_MAX_ELEMENT_NODES], load[SB_MAX_ELEMENT_NODES];
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    int n = body->domain.nodes_per_cell;
    memset(body->lumped_mass, 0, (size_t)body->domain.node_count * sizeof(sb_real));
    memset(body->load_mass, 0, (size_t)body->domain.node_count * sizeof(sb_real));
    if (body->mass_blocks)
        memset(body->mass_blocks, 0, (size_t)body->matrix.block_count * sizeof(sb_real));
    for (int e = 0; e < body->domain.cell_count; e++) {
        const int *cell = body->domain.cells + (size_t)e * (size_t)n;
        sb_real density = body->materials[body->cell_material[e]].density;
        sbi_body_gather_reference(body, e, x);
        if (body->mass_blocks) {
            sbi_element_mass(body->domain.element_type, body->mass_kind, x, mass, load);
            sbi_body_add_mass_blocks(body, e, mass, density, body->mass_blocks);
        }
        sbi_element_mass(body->domain.element_type, SB_MASS_LUMPED, x, mass, load);
        for (int a = 0; a < n; a++) {
            body->lumped_mass[cell[a]] += density * mass[a * n + a];
            body->load_mass[cell[a]] += density * load[a];
        }
    }
}

SBI_API void sbi_body_mass_multiply(const sb_body *body, const sb_vec3 *x, sb_vec3 *out)
{
    const sb_matrix *matrix = &body->matrix;
    for (int i = 0; i < matrix->row_count; i++) {
        sb_vec3 sum = sb_v3(0, 0, 0);
        if (!body->mass_blocks) {
            out[i] = sb_v3_scale(body->lumped_mass[i], x[i]);
            continue;
        }
        for (int k = matrix->row_start[i]; k < matrix->row_start[i + 1]; k++)
            sum = sb_v3_madd(sum, body->mass_blocks[k], x[matrix->columns[k]]);
        out[i] = sum;
    }
}

SBI_API void sbi_body_add_mass(sb_body *body, sb_real factor)
{
    sb_matrix *matrix = &body->matrix;
    for (int i = 0; i < matrix->row_count; i++) {
        int first = body->mass_blocks ? matrix->row_start[i] : matrix->diagonal[i];
        int end = body->mass_blocks ? matrix->row_start[i + 1] : first + 1;
        for (int k = first; k < end; k++) {
            sb_real m = factor * (body->mass_blocks ? body->mass_blocks[k] : body->lumped_mass[i]);
            matrix->blocks[k][0] += m;
            matrix->blocks[k][4] += m;
            matrix->blocks[k][8] += m;
        }
    }
}

static void sbi_body_materials_changed(sb_body *body)
{
    sbi_assembly_set_materials(&body->assembly, body->materials, body->material_count, body->cell_material);
    body->force_unit = body->assembly.energy_unit / sbi_body_size(body);
    sbi_body_update_mass(body);
    body->force_current = 0;
    body->acceleration_known = 0;
}

/* ---- creation: topology ---- */

/* Parts of the mesh, elements of each node, and the matrix pattern. */
static sb_result sbi_body_make_topology(sb_body *body, const sb_mesh *mesh, sb_error *error)
{
    const sb_domain *domain = &body->domain;
    sb_result result = sb_mesh_components(mesh, &body->allocator, &body->element_component, &body->component_count,
                                          error);
    if (result == SB_OK)
        result = sb_mesh_node_elements(mesh, &body->allocator, &body->node_elements, error);
    if (result == SB_OK)
        result = sb_matrix_create(domain->node_count, domain->cell_count, domain->nodes_per_cell, NULL,
                                  domain->cells, &body->allocator, &body->matrix, error);
    return result;
}

/* Grows the bounding box of a part by one of its nodes. */
static void sbi_body_grow_box(sb_body *body, int component, sb_vec3 x)
{
    sb_vec3 *low = body->component_low + component, *high = body->component_high + component;
    *low = sb_v3(sb_min(low->x, x.x), sb_min(low->y, x.y), sb_min(low->z, x.z));
    *high = sb_v3(sb_max(high->x, x.x), sb_max(high->y, x.y), sb_max(high->z, x.z));
}

/* Nodes of no element would make every system singular: they are held. Others learn their part's number. */
static void sbi_body_label_nodes(sb_body *body)
{
    const sb_index_lists *lists = &body->node_elements;
    for (int c = 0; c < body->component_count; c++) {
        body->component_low[c] = sb_v3(SB_REAL_MAX, SB_REAL_MAX, SB_REAL_MAX);
        body->component_high[c] = sb_v3(-SB_REAL_MAX, -SB_REAL_MAX, -SB_REAL_MAX);
    }
    for (int i = 0; i < body->domain.node_count; i++) {
        int first = lists->offsets[i];
        int lonely = first == lists->offsets[i + 1];
        body->node_component[i] = lonely ? -1 : body->element_component.items[lists->items[first]];
        body->fixed[i] = lonely ? SB_XYZ : 0;
        if (!lonely)
            sbi_body_grow_box(body, body->node_component[i], body->reference[i]);
    }
}

/* 1 when one linearised iteration is what SB_AUTO means. Newmark has no damping of its own, so that the errors of
 * linearised steps add up until the body explodes: only a linear body may take them. */
static int sbi_body_is_one_step(const sb_body *body, sb_material_model model)
{
    return model == SB_LINEAR ||
           (body->integrator == SB_EULER && (model == SB_COROTATED || model == SB_COROTATED_INVERTIBLE));
}

SBI_API int sbi_body_max_newton(const sb_body *body)
{
    if (body->max_newton != SB_AUTO)
        return body->max_newton;
    for (int i = 0; i < body->material_count; i++)
        if (!sbi_body_is_one_step(body, body->materials[i].model))
            return 20;
    return 1;
}

/* Steps of several iterations keep the stiffness they damp with: room for it, should these materials need it. */
static sb_result sbi_body_reserve_damping(sb_body *body, const sb_material *materials, int count, sb_error *error)
{
    int needed = body->max_newton > 1;
    for (int i = 0; i < count && body->max_newton == SB_AUTO; i++)
        needed |= !sbi_body_is_one_step(body, materials[i].model);
    if (!needed || body->damping_blocks || body->integrator == SB_CENTRAL_DIFFERENCE)
        return SB_OK;
    body->damping_blocks =
        (sb_real(*)[9])sbi_alloc(&body->allocator, (size_t)body->matrix.block_count + 1, 9 * sizeof(sb_real));
    if (!body->damping_blocks)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the damping of %d blocks", body->matrix.block_count);
    return SB_OK;
}

static sb_result sbi_body_make_preconditioner(sb_body *body, const sb_body_def *def, sb_error *error)
{
    sb_preconditioner_def settings = sb_default_preconditioner_def();
    settings.kind = def->preconditioner;
    settings.positions = def->mesh->nodes;
    return sb_preconditioner_create(&settings, &body->matrix, &body->allocator, &body->precond, error);
}

static sb_result sbi_body_build(sb_body *body, const sb_body_def *def, sb_error *error)
{
    const sb_allocator *allocator = &body->allocator;
    uint64_t *node_colours;
    sb_result result = sb_domain_create(def->mesh, def->integration, def->single_rotation, allocator,
                                        &body->domain, error);
    if (result == SB_OK)
        result = sbi_body_make_materials(body, def, error);
    if (result == SB_OK)
        result = sbi_body_make_topology(body, def->mesh, error);
    if (result == SB_OK)
        result = sbi_body_take_memory(body, error);
    if (result == SB_OK)
        result = sbi_body_make_preconditioner(body, def, error);
    if (result == SB_OK)
        result = sb_pcg_workspace_create(body->domain.node_count, allocator, &body->pcg, error);
    if (result != SB_OK)
        return result;
    node_colours = (uint64_t *)sbi_alloc(allocator, (size_t)body->domain.node_count, sizeof *node_colours);
    if (!node_colours)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory to colour %d nodes", body->domain.node_count);
    body->assembly.jobs = &body->jobs;
    body->assembly.reference = body->reference;
    sbi_assembly_prepare(&body->assembly, &body->matrix, node_colours);
    sbi_free(allocator, node_colours);
    memcpy(body->reference, def->mesh->nodes, (size_t)body->domain.node_count * sizeof(sb_vec3));
    sbi_body_label_nodes(body);
    sbi_body_materials_changed(body);
    sb_body_reset(body);
    return sbi_body_reserve_damping(body, body->materials, body->material_count, error);
}

SB_API sb_result sb_body_create(const sb_body_def *def, sb_body **body, sb_error *error)
{
    sb_body *made;
    sb_result result;
    if (!def || !body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_create needs a def and a place for the body");
    result = sbi_body_check_def(def, error);
    if (result != SB_OK)
        return result;
    made = (sb_body *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a body");
    made->allocator = def->allocator;
    made->jobs = def->jobs;
    made->clock = def->clock;
    made->mass_kind = def->mass;
    made->integrator = def->integrator;
    made->gravity = def->gravity;
    made->damping_mass = def->damping_mass;
    made->damping_stiffness = def->damping_stiffness;
    made->tolerance = def->tolerance;
    made->newton_tolerance = def->newton_tolerance;
    made->max_iterations = def->max_iterations;
    made->max_newton = def->max_newton;
    made->spectral_radius = def->spectral_radius;
    made->max_substeps = def->max_substeps;
    result = sbi_body_build(made, def, error);
    if (result != SB_OK) {
        sb_body_destroy(made);
        return result;
    }
    *body = made;
    return SB_OK;
}

SB_API void sb_body_destroy(sb_body *body)
{
    sb_allocator allocator;
    if (!body)
        return;
    allocator = body->allocator;
    sb_pcg_workspace_free(&body->pcg);
    sb_preconditioner_free(body->precond);
    sb_matrix_free(&body->matrix);
    sb_index_table_free(&body->element_component);
    sb_index_lists_free(&body->node_elements);
    sb_domain_free(&body->domain);
    sbi_free(&allocator, body->support_blocks);
    sbi_free(&allocator, body->damping_blocks);
    sbi_free(&allocator, body->cell_material);
    sbi_free(&allocator, body->materials);
    sbi_free(&allocator, body->material_regions);
    sbi_free(&allocator, body->memory);
    sbi_free(&allocator, body);
}

/* ---- sizes ---- */

SB_API int sb_body_node_count(const sb_body *body) { return body->domain.node_count; }
SB_API int sb_body_element_count(const sb_body *body) { return body->domain.cell_count; }
SB_API int sb_body_point_count(const sb_body *body) { return body->domain.points_per_cell; }
SB_API int sb_body_matrix_blocks(const sb_body *body) { return body->matrix.block_count; }

/* ---- properties ---- */

SB_API sb_result sb_body_set_material(sb_body *body, const sb_material *material, sb_error *error)
{
    sb_result result;
    if (!body || !material)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_set_material needs a body and a material");
    result = sbi_body_check_material(material, body->domain.single_rotation, error);
    if (result == SB_OK)
        result = sbi_body_reserve_damping(body, material, 1, error);
    if (result != SB_OK)
        return result;
    for (int i = 0; i < body->material_count; i++)
        body->materials[i] = *material;
    sbi_body_materials_changed(body);
    return SB_OK;
}

SB_API sb_result sb_body_set_region_material(sb_body *body, int region, const sb_material *material,
                                             sb_error *error)
{
    sb_result result;
    int at, found;
    if (!body || !material)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_set_region_material needs a body and a material");
    at = sbi_body_find_region(body->material_regions, body->material_count, region, &found);
    if (!found)
        return sbi_fail(error, SB_ERROR_INDEX, "the mesh has no region %d", region);
    result = sbi_body_check_material(material, body->domain.single_rotation, error);
    if (result == SB_OK)
        result = sbi_body_reserve_damping(body, material, 1, error);
    if (result != SB_OK)
        return result;
    body->materials[at] = *material;
    sbi_body_materials_changed(body);
    return SB_OK;
}

SB_API sb_result sb_body_set_gravity(sb_body *body, sb_vec3 gravity)
{
    if (!body)
        return SB_ERROR_ARGUMENT;
    if (!sb_v3_is_finite(gravity))
        return SB_ERROR_NOT_FINITE;
    body->gravity = gravity;
    return SB_OK;
}

SB_API sb_result sb_body_set_damping(sb_body *body, sb_real alpha, sb_real beta)
{
    if (!body || !(alpha >= 0) || !(beta >= 0) || !sb_is_finite(alpha) || !sb_is_finite(beta))
        return SB_ERROR_ARGUMENT;
    if (body->integrator == SB_CENTRAL_DIFFERENCE && beta > 0)
        return SB_ERROR_UNSUPPORTED;
    body->damping_mass = alpha;
    body->damping_stiffness = beta;
    return SB_OK;
}

SB_API sb_result sb_body_set_solver(sb_body *body, sb_real tolerance, int max_iterations)
{
    if (!body || !(tolerance > 0) || !(tolerance < 1) || max_iterations < 1)
        return SB_ERROR_ARGUMENT;
    body->tolerance = tolerance;
    body->max_iterations = max_iterations;
    return SB_OK;
}

/* ---- supports ---- */

static sb_result sbi_body_check_nodes(const sb_body *body, const int *nodes, int count)
{
    if (!body || count < 0 || (count > 0 && !nodes))
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < count; i++)
        if (nodes[i] < 0 || nodes[i] >= body->domain.node_count)
            return SB_ERROR_INDEX;
    return SB_OK;
}

static int sbi_body_row_length(const sb_body *body, int node)
{
    return body->matrix.row_start[node + 1] - body->matrix.row_start[node];
}

/* Room for the tangent rows of the supports to come: reactions are read from them. The count is an upper bound (a
 * node listed twice counts twice). */
static sb_result sbi_body_reserve_supports(sb_body *body, const int *nodes, int count)
{
    int needed = body->support_used, most = body->matrix.block_count, capacity;
    void *blocks;
    for (int i = 0; i < count; i++)
        if (!body->fixed[nodes[i]])
            needed += sbi_min_int(sbi_body_row_length(body, nodes[i]), most - needed);
    if (needed <= body->support_capacity)
        return SB_OK;
    capacity = needed > most / 2 ? most : needed + needed / 2;
    blocks = sbi_alloc(&body->allocator, (size_t)capacity, 9 * sizeof(sb_real));
    if (!blocks)
        return SB_ERROR_MEMORY;
    sbi_free(&body->allocator, body->support_blocks);
    body->support_blocks = (sb_real(*)[9])blocks;
    body->support_capacity = capacity;
    return SB_OK;
}

SBI_API sb_vec3 sbi_body_pick_axes(unsigned axes, sb_vec3 value, sb_vec3 otherwise)
{
    return sb_v3(axes & SB_X ? value.x : otherwise.x, axes & SB_Y ? value.y : otherwise.y,
                 axes & SB_Z ? value.z : otherwise.z);
}

/* Supports axes of the nodes with target targets[i * stride], or where they are now when targets is NULL. */
static sb_result sbi_body_support(sb_body *body, const int *nodes, int count, int axes, const sb_vec3 *targets,
                                  int stride)
{
    sb_result result = sbi_body_check_nodes(body, nodes, count);
    if (result != SB_OK)
        return result;
    if (axes < 0 || axes > SB_XYZ)
        return SB_ERROR_ARGUMENT;
    if (axes == 0)
        return SB_OK;
    result = sbi_body_reserve_supports(body, nodes, count);
    for (int i = 0; i < count && result == SB_OK; i++) {
        int node = nodes[i];
        if (!body->fixed[node])
            body->support_used += sbi_body_row_length(body, node);
        body->fixed[node] |= (unsigned char)axes;
        body->target[node] = sbi_body_pick_axes((unsigned)axes, targets ? targets[i * stride] : body->displacement[node],
                                                body->target[node]);
    }
    return result;
}

SB_API sb_result sb_body_fix_nodes(sb_body *body, const int *nodes, int count, int axes)
{
    return sbi_body_support(body, nodes, count, axes, NULL, 0);
}

SB_API sb_result sb_body_prescribe(sb_body *body, const int *nodes, int count, int axes,
                                   const sb_vec3 *displacements, int uniform)
{
    if (!body || count < 0 || (count > 0 && !displacements))
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < (uniform ? sbi_min_int(count, 1) : count); i++)
        if (!sb_v3_is_finite(displacements[i]))
            return SB_ERROR_NOT_FINITE;
    return sbi_body_support(body, nodes, count, axes, displacements, uniform ? 0 : 1);
}

SB_API sb_result sb_body_release_nodes(sb_body *body, const int *nodes, int count, int axes)
{
    sb_result result = sbi_body_check_nodes(body, nodes, count);
    if (result != SB_OK)
        return result;
    if (axes < 0 || axes > SB_XYZ)
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < count; i++)
        if (body->node_component[nodes[i]] >= 0) {
            int held = body->fixed[nodes[i]];
            body->fixed[nodes[i]] &= (unsigned char)~axes;
            if (held && !body->fixed[nodes[i]])
                body->support_used -= sbi_body_row_length(body, nodes[i]);
            body->reaction[nodes[i]] =
                sbi_body_pick_axes((unsigned)axes, sb_v3(0, 0, 0), body->reaction[nodes[i]]);
        }
    return SB_OK;
}

SB_API const unsigned char *sb_body_supports(const sb_body *body) { return body->fixed; }

/* ---- loads ---- */

SB_API sb_result sb_body_add_forces(sb_body *body, const int *nodes, int count, const sb_vec3 *forces, int uniform)
{
    sb_result result = sbi_body_check_nodes(body, nodes, count);
    if (result != SB_OK)
        return result;
    if (count > 0 && !forces)
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < (uniform ? sbi_min_int(count, 1) : count); i++)
        if (!sb_v3_is_finite(forces[i]))
            return SB_ERROR_NOT_FINITE;
    for (int i = 0; i < count; i++)
        body->dead_load[nodes[i]] = sb_v3_add(body->dead_load[nodes[i]], forces[uniform ? 0 : i]);
    return SB_OK;
}

SB_API void sb_body_clear_loads(sb_body *body)
{
    memset(body->dead_load, 0, (size_t)body->domain.node_count * sizeof(sb_vec3));
}

/* 1 when the named corners of an element (all different) are those of the list. */
static int sbi_body_has_corners(const int *list, const int *cell, const int *local, int count)
{
    int found = 0;
    for (int k = 0; k < count; k++)
        for (int i = 0; i < count; i++)
            if (cell[local[k]] == list[i]) {
                found++;
                break;
            }
    return found == count;
}

/* Finds the element face with these corner nodes: its global nodes, count and type; 0 when there is none. */
static int sbi_body_find_face(const sb_body *body, const int *corners, int count, int *nodes,
                              sb_element_type *face_type)
{
    const sb_index_lists *lists = &body->node_elements;
    sb_element_type type = body->domain.element_type;
    int n = body->domain.nodes_per_cell;
    for (int k = lists->offsets[corners[0]]; k < lists->offsets[corners[0] + 1]; k++) {
        const int *cell = body->domain.cells + (size_t)lists->items[k] * (size_t)n;
        for (int face = 0; face < sb_element_face_count(type); face++) {
            int local[SB_MAX_FACE_NODES], face_nodes = sb_element_face(type, face, local, face_type);
            if (sb_element_corner_count(*face_type) != count ||
                !sbi_body_has_corners(corners, cell, local, count))
                continue;
            for (int i = 0; i < face_nodes; i++)
                nodes[i] = cell[local[i]];
            return face_nodes;
        }
    }
    return 0;
}

/* load_a += int t N_a dA over a face of the reference shape. */
static void sbi_body_add_face_load(sb_body *body, const int *nodes, int count, sb_element_type face_type,
                                   sb_vec3 traction)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    int q = sb_element_quadrature(face_type, SB_QUADRATURE_FACE, points, weights);
    for (int p = 0; p < q; p++) {
        sb_real shape[SB_MAX_ELEMENT_NODES], gradient[SB_MAX_ELEMENT_NODES][3], area;
        sb_vec3 r = sb_v3(0, 0, 0), s = r;
        sb_element_shape(face_type, points[p], shape, gradient);
        for (int a = 0; a < count; a++) {
            r = sb_v3_madd(r, gradient[a][0], body->reference[nodes[a]]);
            s = sb_v3_madd(s, gradient[a][1], body->reference[nodes[a]]);
        }
        area = weights[p] * sb_v3_norm(sb_v3_cross(r, s));
        for (int a = 0; a < count; a++)
            body->dead_load[nodes[a]] = sb_v3_madd(body->dead_load[nodes[a]], area * shape[a], traction);
    }
}

SB_API sb_result sb_body_add_traction(sb_body *body, const int *faces, int face_count, int corners,
                                      sb_vec3 traction, sb_error *error)
{
    int nodes[SB_MAX_FACE_NODES];
    sb_element_type face_type;
    if (!body || face_count < 0 || corners < 3 || corners > 4 || (face_count > 0 && !faces))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_add_traction needs faces of 3 or 4 corners");
    if (!sb_v3_is_finite(traction))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the traction is not finite");
    for (int pass = 0; pass < 2; pass++) /* find all faces before any load changes */
        for (int f = 0; f < face_count; f++) {
            const int *face = faces + (size_t)f * (size_t)corners;
            int count;
            if (pass == 0 && sbi_body_check_nodes(body, face, corners) != SB_OK)
                return sbi_fail(error, SB_ERROR_INDEX, "face %d has a node index outside the mesh", f);
            count = sbi_body_find_face(body, face, corners, nodes, &face_type);
            if (count == 0)
                return sbi_fail_node(error, SB_ERROR_ARGUMENT, face[0],
                                     "face %d (nodes %d %d %d ...) is no face of an element", f, face[0], face[1],
                                     face[2]);
            if (pass == 1)
                sbi_body_add_face_load(body, nodes, count, face_type, traction);
        }
    return SB_OK;
}

/* ---- state ---- */

SB_API const sb_vec3 *sb_body_positions(const sb_body *body) { return body->position; }
SB_API const sb_vec3 *sb_body_displacements(const sb_body *body) { return body->displacement; }
SB_API const sb_vec3 *sb_body_velocities(const sb_body *body) { return body->velocity; }
SB_API const sb_vec3 *sb_body_reactions(const sb_body *body) { return body->reaction; }
SB_API const sb_vec3 *sb_body_external_forces(const sb_body *body) { return body->external; }

static int sbi_body_all_finite(const sb_vec3 *values, int count)
{
    for (int i = 0; i < count; i++)
        if (!sb_v3_is_finite(values[i]))
            return 0;
    return 1;
}

SBI_API void sbi_body_update_positions(sb_body *body)
{
    for (int i = 0; i < body->domain.node_count; i++)
        body->position[i] = sb_v3_add(body->reference[i], body->displacement[i]);
}

SB_API sb_result sb_body_set_displacements(sb_body *body, const sb_vec3 *displacements)
{
    if (!body || !displacements)
        return SB_ERROR_ARGUMENT;
    if (!sbi_body_all_finite(displacements, body->domain.node_count))
        return SB_ERROR_NOT_FINITE;
    memmove(body->displacement, displacements, (size_t)body->domain.node_count * sizeof(sb_vec3));
    sbi_body_update_positions(body);
    body->force_current = 0;
    body->acceleration_known = 0;
    return SB_OK;
}

SB_API sb_result sb_body_set_velocities(sb_body *body, const sb_vec3 *velocities)
{
    if (!body || !velocities)
        return SB_ERROR_ARGUMENT;
    if (!sbi_body_all_finite(velocities, body->domain.node_count))
        return SB_ERROR_NOT_FINITE;
    memmove(body->velocity, velocities, (size_t)body->domain.node_count * sizeof(sb_vec3));
    body->acceleration_known = 0;
    return SB_OK;
}

SB_API void sb_body_reset(sb_body *body)
{
    size_t bytes = (size_t)body->domain.node_count * sizeof(sb_vec3);
    memset(body->displacement, 0, bytes);
    memset(body->velocity, 0, bytes);
    memset(body->acceleration, 0, bytes);
    memset(body->reaction, 0, bytes);
    memset(body->external, 0, bytes);
    memset(body->equilibrated, 0, bytes);
    sbi_assembly_reset_rotations(&body->assembly);
    sbi_body_update_positions(body);
    body->force_current = 0;
    body->acceleration_known = 0;
}

/* ---- readings ---- */

SB_API sb_result sb_body_energy(sb_body *body, sb_energy *energy)
{
    sb_energy sum = {0, 0};
    if (!body || !energy)
        return SB_ERROR_ARGUMENT;
    if (sbi_assembly_energy(&body->assembly, body->displacement, &sum.elastic) >= 0)
        return SB_ERROR_INVERTED;
    sbi_body_mass_multiply(body, body->velocity, body->work);
    for (int i = 0; i < body->domain.node_count; i++)
        sum.kinetic += (sb_real)0.5 * sb_v3_dot(body->velocity[i], body->work[i]);
    if (!sb_is_finite(sum.elastic) || !sb_is_finite(sum.kinetic))
        return SB_ERROR_NOT_FINITE;
    *energy = sum;
    return SB_OK;
}

SB_API sb_real sb_body_mass(const sb_body *body)
{
    sb_real sum = 0;
    for (int i = 0; i < body->domain.node_count; i++)
        sum += body->lumped_mass[i];
    return sum;
}

SB_API sb_vec3 sb_body_momentum(const sb_body *body)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int i = 0; i < body->domain.node_count; i++)
        sum = sb_v3_madd(sum, body->mass_blocks ? body->load_mass[i] : body->lumped_mass[i], body->velocity[i]);
    return sum;
}

/* Cauchy stresses at the points of an element; 0, and admissible[point] 0, where there is none. */
static void sbi_body_element_stresses(const sb_body *body, int element, sb_mat3 *stress, int *admissible)
{
    const sb_material *material = body->materials + body->cell_material[element];
    sb_mat3 f[SB_MAX_QUADRATURE_POINTS], p[SB_MAX_QUADRATURE_POINTS];
    sbi_assembly_points(&body->assembly, body->displacement, element, f, p, admissible);
    for (int i = 0; i < body->domain.points_per_cell; i++) {
        if (material->model != SB_LINEAR && sb_m3_det(f[i]) == 0)
            admissible[i] = 0;
        if (admissible[i])
            stress[i] = sb_material_cauchy_stress(material, f[i], p[i]);
        if (!admissible[i] || !sb_is_finite(sb_von_mises(stress[i]))) { /* beyond what sb_real holds, too */
            stress[i] = sb_m3_zero();
            admissible[i] = 0;
        }
    }
}

SB_API sb_result sb_body_stress(const sb_body *body, int element, int point, sb_mat3 *stress)
{
    sb_mat3 all[SB_MAX_QUADRATURE_POINTS];
    int admissible[SB_MAX_QUADRATURE_POINTS];
    if (!body || !stress)
        return SB_ERROR_ARGUMENT;
    if (element < 0 || element >= body->domain.cell_count || point < 0 || point >= body->domain.points_per_cell)
        return SB_ERROR_INDEX;
    sbi_body_element_stresses(body, element, all, admissible);
    if (!admissible[point])
        return SB_ERROR_INVERTED;
    *stress = all[point];
    return SB_OK;
}

static sb_real sbi_body_element_von_mises(const sb_body *body, int element)
{
    sb_mat3 stress[SB_MAX_QUADRATURE_POINTS];
    int admissible[SB_MAX_QUADRATURE_POINTS];
    sb_real sum = 0;
    sbi_body_element_stresses(body, element, stress, admissible);
    for (int p = 0; p < body->domain.points_per_cell; p++)
        sum += sb_von_mises(stress[p]);
    return sum / (sb_real)body->domain.points_per_cell;
}

SB_API void sb_body_von_mises(const sb_body *body, sb_real *values)
{
    for (int e = 0; e < body->domain.cell_count; e++)
        values[e] = sbi_body_element_von_mises(body, e);
}

static sb_real sbi_body_element_volume(const sb_body *body, int element)
{
    sb_real sum = 0;
    int q = body->domain.points_per_cell;
    for (int p = 0; p < q; p++)
        sum += body->domain.weights[(size_t)element * (size_t)q + (size_t)p];
    return sum;
}

SB_API void sb_body_nodal_von_mises(const sb_body *body, sb_real *values)
{
    const sb_domain *domain = &body->domain;
    const sb_index_lists *lists = &body->node_elements;
    for (int i = 0; i < domain->node_count; i++)
        values[i] = 0;
    for (int e = 0; e < domain->cell_count; e++) {
        sb_real value = sbi_body_element_von_mises(body, e) * sbi_body_element_volume(body, e);
        for (int a = 0; a < domain->nodes_per_cell; a++)
            values[domain->cells[(size_t)e * (size_t)domain->nodes_per_cell + (size_t)a]] += value;
    }
    for (int i = 0; i < domain->node_count; i++) {
        sb_real volume = 0;
        for (int k = lists->offsets[i]; k < lists->offsets[i + 1]; k++)
            volume += sbi_body_element_volume(body, lists->items[k]);
        values[i] = volume > 0 ? values[i] / volume : 0;
    }
}

/* ---- set-up check ---- */

/* Adds row r r^T of one supported axis: r is what the six rigid motions do to it. */
static void sbi_body_add_support(double *gram, const double *arm, int axis)
{
    double r[6] = {0, 0, 0, 0, 0, 0};
    r[axis] = 1;
    r[3 + (axis + 1) % 3] = arm[(axis + 2) % 3]; /* (omega x arm)_axis */
    r[3 + (axis + 2) % 3] = -arm[(axis + 1) % 3];
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++)
            gram[6 * i + j] += r[i] * r[j];
}

/* Rank 6 by Gauss elimination with diagonal pivots; arms are of order 1, so pivots compare with the trace. */
static int sbi_body_has_full_rank(double *gram)
{
    double trace = 0;
    unsigned done = 0;
    for (int i = 0; i < 6; i++)
        trace += gram[7 * i];
    for (int step = 0; step < 6; step++) {
        int pivot = -1;
        for (int i = 0; i < 6; i++)
            if (!(done >> i & 1) && (pivot < 0 || gram[7 * i] > gram[7 * pivot]))
                pivot = i;
        if (!(gram[7 * pivot] > 1e-10 * trace))
            return 0;
        done |= 1u << pivot;
        for (int i = 0; i < 6; i++)
            for (int j = 0; j < 6 && !(done >> i & 1); j++)
                if (!(done >> j & 1))
                    gram[6 * i + j] -= gram[6 * i + pivot] * gram[6 * j + pivot] / gram[7 * pivot];
    }
    return 1;
}

/* Arm of a node about the centre of its part, in units of the part's size. */
static void sbi_body_arm(const sb_body *body, int node, double arm[3])
{
    sb_vec3 low = body->component_low[body->node_component[node]];
    sb_vec3 high = body->component_high[body->node_component[node]], x = body->reference[node];
    double size = (double)sb_v3_norm(sb_v3_sub(high, low));
    arm[0] = ((double)x.x - 0.5 * ((double)low.x + (double)high.x)) / size;
    arm[1] = ((double)x.y - 0.5 * ((double)low.y + (double)high.y)) / size;
    arm[2] = ((double)x.z - 0.5 * ((double)low.z + (double)high.z)) / size;
}

SBI_API int sbi_body_unsupported_node(const sb_body *body)
{
    memset(body->support_grams, 0, (size_t)body->component_count * sizeof body->support_grams[0]);
    for (int i = 0; i < body->domain.node_count; i++) {
        double arm[3];
        if (!body->fixed[i] || body->node_component[i] < 0)
            continue;
        sbi_body_arm(body, i, arm);
        for (int axis = 0; axis < 3; axis++)
            if (body->fixed[i] >> axis & 1)
                sbi_body_add_support(body->support_grams[body->node_component[i]], arm, axis);
    }
    for (int c = 0; c < body->component_count; c++)
        if (!sbi_body_has_full_rank(body->support_grams[c]))
            for (int i = 0; i < body->domain.node_count; i++)
                if (body->node_component[i] == c)
                    return i;
    return -1;
}

/* 1 when an element before this one has the same corners. */
static int sbi_body_is_duplicate(const sb_body *body, int element)
{
    const sb_index_lists *lists = &body->node_elements;
    int n = body->domain.nodes_per_cell, corners = sb_element_corner_count(body->domain.element_type);
    const int *cell = body->domain.cells + (size_t)element * (size_t)n;
    static const int local[8] = {0, 1, 2, 3, 4, 5, 6, 7};
    for (int k = lists->offsets[cell[0]]; lists->items[k] < element; k++)
        if (sbi_body_has_corners(cell, body->domain.cells + (size_t)lists->items[k] * (size_t)n, local, corners))
            return 1;
    return 0;
}

static void sbi_body_check_mesh(const sb_body *body, sb_check_report *report)
{
    sb_mesh mesh = sbi_body_mesh_view(body);
    report->size = sbi_body_size(body);
    report->worst_quality = 1;
    for (int e = 0; e < mesh.element_count; e++) {
        sb_real quality = sb_mesh_element_quality(&mesh, e);
        report->sliver_count += quality < (sb_real)0.1;
        report->duplicate_count += sbi_body_is_duplicate(body, e);
        if (report->worst_element < 0 || quality < report->worst_quality) {
            report->worst_quality = quality;
            report->worst_element = e;
        }
    }
    for (int i = 0; i < mesh.node_count; i++)
        report->unreferenced_count += body->node_component[i] < 0;
    report->component_count = body->component_count;
    if (report->size > 10 || report->size < (sb_real)1e-3)
        report->warnings |= SB_CHECK_SIZE;
    if (report->sliver_count > 0)
        report->warnings |= SB_CHECK_SLIVERS;
    if (report->unreferenced_count > 0)
        report->warnings |= SB_CHECK_UNREFERENCED;
    if (report->duplicate_count > 0)
        report->warnings |= SB_CHECK_DUPLICATES;
    if (report->component_count > 1)
        report->warnings |= SB_CHECK_COMPONENTS;
}

static void sbi_body_check_materials(const sb_body *body, sb_check_report *report)
{
    int locks = body->domain.element_type == SB_TET4 || body->domain.element_type == SB_HEX8;
    for (int i = 0; i < body->material_count; i++) {
        const sb_material *material = body->materials + i;
        sb_real young = sb_material_young(material);
        if (material->density < 100 || material->density > 10000)
            report->warnings |= SB_CHECK_DENSITY;
        if (young < 10 || young > (sb_real)1e7)
            report->warnings |= SB_CHECK_STIFFNESS;
        if (locks && sb_material_poisson(material) > (sb_real)0.49)
            report->warnings |= SB_CHECK_LOCKING;
    }
}

SB_API sb_result sb_body_check(const sb_body *body, sb_check_report *report)
{
    if (!body || !report)
        return SB_ERROR_ARGUMENT;
    memset(report, 0, sizeof *report);
    report->worst_element = -1;
    sbi_body_check_mesh(body, report);
    sbi_body_check_materials(body, report);
    report->unsupported_component_node = sbi_body_unsupported_node(body);
    if (report->unsupported_component_node >= 0)
        report->warnings |= SB_CHECK_UNSUPPORTED;
    return SB_OK;
}

SB_API const char *sb_check_string(unsigned warning)
{
    switch (warning) {
    case SB_CHECK_SIZE: return "the mesh is larger than 10 m or smaller than 1 mm: is it in metres?";
    case SB_CHECK_DENSITY: return "a density is outside 100 to 10,000 kg/m^3: are the units SI?";
    case SB_CHECK_STIFFNESS: return "a Young's modulus is outside 10 Pa to 10 MPa: are the units SI?";
    case SB_CHECK_SLIVERS: return "some elements are slivers (quality under 0.1): solves will be slow";
    case SB_CHECK_LOCKING: return "Poisson's ratio above 0.49 locks tet4 and hex8: use tet10";
    case SB_CHECK_UNREFERENCED: return "some nodes belong to no element and are held in place";
    case SB_CHECK_UNSUPPORTED: return "a part is not fully supported: static solves will refuse it";
    case SB_CHECK_DUPLICATES: return "some elements are there twice: their mass and stiffness count twice";
    case SB_CHECK_COMPONENTS: return "the mesh has more than one connected part";
    default: return "unknown warning";
    }
}

/* ==== src/softbody/step_explicit.h ==== */
/* step_explicit: central differences, the part of step that solves no systems. Floor 3, internal. */
#ifndef SB_STEP_EXPLICIT_H
#define SB_STEP_EXPLICIT_H


/* Times that a call is done again with shorter substeps. */
enum { SBI_EXPLICIT_CAUTION = 3 };

/* Moves the body by dt (s) in as many substeps as stability needs; caution 0 .. SBI_EXPLICIT_CAUTION makes them
 * shorter and the looks at the stable step more frequent. body->start and the dead loads in body->external are up to
 * date. On failure the state is anywhere in between: the caller undoes it, and body->guard. */
SBI_API sb_result sbi_explicit_run(sb_body *body, sb_real dt, int caution, sb_step_info *info);

/* Takes note of a call that went well; after a run of them the next may be bolder. */
SBI_API void sbi_explicit_calm(sb_body *body, int caution);
/* The stable step (s) of the stiffness in the body's matrix with the lumped mass; not positive or not finite when there
 * is none. Overwrites the body's work vectors. */
SBI_API sb_real sbi_explicit_bound(sb_body *body);

#endif /* SB_STEP_EXPLICIT_H */

/* ==== src/softbody/step_explicit.c ==== */
/* step_explicit: central differences in the form of velocities at the same times as displacements (Newmark beta 0,
 * gamma 1/2), which can change the length of its steps.
 *
 * What keeps it from exploding: substeps below the stable step, which comes from an upper bound of the highest
 * frequency at the present shape and is looked at again as the shape changes; and a ledger of energy. A body has no
 * more energy than it had and was given since by loads and supports, up to a factor of order 1; where stiffness grows
 * faster than one looks, substeps multiply it. A call that breaks the ledger is done again with more caution, and what
 * the most cautious one arrives at opens a new ledger. */

#include <math.h>
#include <string.h>

enum { SBI_EXPLICIT_SWEEPS = 12 }; /* of the iteration for the bound: its gain per sweep is below 1 % then */

/* How a call goes about its way. */
typedef struct sbi_explicit_plan {
    sb_real margin;           /* substeps are at most this share of the stable step */
    int interval;             /* substeps between looks, each of which costs as much as some ten forces */
    double factor;            /* energy over that of the ledger that is taken for granted: near the limit, elastic
                               * energy swings to 1/(1 - margin^2) times what its frequency has */
} sbi_explicit_plan;

static const sbi_explicit_plan sbi_explicit_plans[SBI_EXPLICIT_CAUTION + 1] = {
    {(sb_real)0.9, 16, 1.5}, {(sb_real)0.45, 4, 1.5}, {(sb_real)0.225, 1, 1.25}, {(sb_real)0.08, 1, 1.25}};

typedef struct sbi_explicit {
    sb_body *body;
    sb_step_info *info;
    const sbi_explicit_plan *plan;
    int last_resort;          /* 1: the energy at the start of the call counts, whatever the ledger says */
    double start_energy;      /* then (J) */
} sbi_explicit;

static double sbi_explicit_now(const sb_body *body) { return body->clock ? body->clock() : 0.0; }

/* Energy that rounding may pretend (J). */
static double sbi_explicit_noise(const sb_body *b)
{
    return 64 * (double)SB_EPSILON * (double)b->assembly.energy_unit;
}

/* ---- the stable step ---- */

/* y = M^-1 |K| x; returns the largest y_i / x_i, which no eigenvalue of M^-1 K exceeds. */
static sb_real sbi_explicit_sweep(const sb_body *b, const sb_vec3 *x, sb_vec3 *y)
{
    const sb_matrix *matrix = &b->matrix;
    sb_real largest = 0;
    for (int i = 0; i < matrix->row_count; i++) {
        sb_vec3 sum = sb_v3(0, 0, 0);
        if (!(b->lumped_mass[i] > 0)) { /* of no element: no equation of motion */
            y[i] = sum;
            continue;
        }
        for (int k = matrix->row_start[i]; k < matrix->row_start[i + 1]; k++) {
            const sb_real *m = matrix->blocks[k];
            sb_vec3 v = x[matrix->columns[k]];
            sum.x += sb_abs(m[0]) * v.x + sb_abs(m[1]) * v.y + sb_abs(m[2]) * v.z;
            sum.y += sb_abs(m[3]) * v.x + sb_abs(m[4]) * v.y + sb_abs(m[5]) * v.z;
            sum.z += sb_abs(m[6]) * v.x + sb_abs(m[7]) * v.y + sb_abs(m[8]) * v.z;
        }
        y[i] = sb_v3_scale(1 / b->lumped_mass[i], sum);
        if (!sb_v3_is_finite(y[i]))
            return y[i].x + y[i].y + y[i].z;
        largest = x[i].x > 0 ? sb_max(largest, y[i].x / x[i].x) : largest;
        largest = x[i].y > 0 ? sb_max(largest, y[i].y / x[i].y) : largest;
        largest = x[i].z > 0 ? sb_max(largest, y[i].z / x[i].z) : largest;
    }
    return largest;
}

/* x = y over its largest component. A component of 0 has a row of zeros and stays out. */
static void sbi_explicit_normalise(const sb_vec3 *y, int count, sb_vec3 *x)
{
    sb_real size = 0;
    for (int i = 0; i < count; i++)
        size = sb_max(size, sb_max(y[i].x, sb_max(y[i].y, y[i].z)));
    for (int i = 0; i < count; i++)
        x[i] = sb_v3_scale(size > 0 ? 1 / size : 0, y[i]);
}

/* Every sweep gives a bound: the least of them counts. */
SBI_API sb_real sbi_explicit_bound(sb_body *b)
{
    sb_real least = SB_REAL_MAX, rounding = 1 + 64 * SB_EPSILON;
    for (int i = 0; i < b->matrix.row_count; i++)
        b->work[i] = sb_v3(1, 1, 1);
    for (int sweep = 0; sweep < SBI_EXPLICIT_SWEEPS; sweep++) {
        sb_real bound = sbi_explicit_sweep(b, b->work, b->work2);
        if (!sb_is_finite(bound))
            return bound;
        least = sb_min(least, bound);
        sbi_explicit_normalise(b->work2, b->matrix.row_count, b->work);
    }
    return 2 / sb_sqrt(least * rounding);
}

/* The stable step at the present displacement, whose rotations are up to date. The positive part of the tangent bounds
 * the tangent. */
static sb_result sbi_explicit_stable_step(sb_body *b, sb_real *dt, sb_error *error)
{
    sb_real found;
    int bad = sbi_assembly_tangent(&b->assembly, b->displacement, SB_TANGENT_SPD, 1, &b->matrix);
    if (bad >= 0)
        return sbi_fail_element(error, SB_ERROR_INVERTED, bad,
                                "element %d is inside out, which its material does not allow", bad);
    found = sbi_explicit_bound(b);
    if (!(found > 0) || !sb_is_finite(found))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the stiffness is beyond what numbers can hold");
    *dt = found;
    return SB_OK;
}

SB_API sb_result sb_body_stable_step(sb_body *body, sb_real *dt, sb_error *error)
{
    sb_result result = SB_OK;
    int bad = -1;
    if (!body || !dt)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_stable_step needs a body and a place for dt");
    if (body->force_current)
        return sbi_explicit_stable_step(body, dt, error);
    sbi_assembly_save_rotations(&body->assembly); /* forces leave traces in the warm starts */
    bad = sbi_assembly_force(&body->assembly, body->displacement, body->residual);
    if (bad >= 0)
        result = sbi_fail_element(error, SB_ERROR_INVERTED, bad,
                                  "element %d is inside out, which its material does not allow", bad);
    else
        result = sbi_explicit_stable_step(body, dt, error);
    sbi_assembly_restore_rotations(&body->assembly);
    return result;
}

/* ---- looks at energy and stability ---- */

static double sbi_explicit_kinetic(const sb_body *b)
{
    double sum = 0;
    for (int i = 0; i < b->domain.node_count; i++)
        sum += 0.5 * (double)b->lumped_mass[i] * (double)sb_v3_dot(b->velocity[i], b->velocity[i]);
    return sum;
}

/* Whether an energy agrees with the ledger; false for NaN. */
static sb_result sbi_explicit_audit(const sbi_explicit *x, double energy)
{
    const sb_body *b = x->body;
    double given = b->guard.energy > x->start_energy ? b->guard.energy : x->start_energy;
    if (energy <= x->plan->factor * given + sbi_explicit_noise(b))
        return SB_OK;
    for (int i = 0; i < b->domain.node_count; i++)
        if (!sb_v3_is_finite(b->velocity[i]))
            return sbi_fail_node(&x->info->error, SB_ERROR_DIVERGED, i, "the velocity of node %d is not finite", i);
    return sbi_fail(&x->info->error, SB_ERROR_DIVERGED, "the body has %g J, but was given no more than %g J", energy,
                    given);
}

/* Compares all energy with the ledger, takes what was lost off it, and finds the stable step of the present shape. */
static sb_result sbi_explicit_look(sbi_explicit *x)
{
    sb_body *b = x->body;
    sb_step_info *info = x->info;
    double begin = sbi_explicit_now(b), energy;
    sb_real elastic = 0;
    int bad = sbi_assembly_energy(&b->assembly, b->displacement, &elastic);
    sb_result result;
    if (bad >= 0)
        return sbi_fail_element(&info->error, SB_ERROR_INVERTED, bad,
                                "element %d is inside out, which its material does not allow", bad);
    energy = (double)elastic + sbi_explicit_kinetic(b);
    if (!b->guard.ledger_open || (x->last_resort && info->substeps == 0)) {
        x->start_energy = energy;
        b->guard.energy = energy;
        b->guard.ledger_open = 1;
    }
    result = sbi_explicit_audit(x, energy);
    if (result != SB_OK)
        return result;
    b->guard.energy = energy < b->guard.energy ? energy : b->guard.energy;
    b->guard.age = 0;
    result = sbi_explicit_stable_step(b, &b->guard.stable_step, &info->error);
    info->seconds_tangent += sbi_explicit_now(b) - begin;
    return result;
}

/* ---- motion ---- */

/* internal = forces at the present displacement. What else depends on the shape belongs here too. */
static sb_result sbi_explicit_force(sb_body *b, sb_step_info *info)
{
    double begin = sbi_explicit_now(b);
    int bad = -1;
    if (!b->force_current)
        bad = sbi_assembly_force(&b->assembly, b->displacement, b->internal);
    b->force_current = bad < 0;
    info->seconds_force += sbi_explicit_now(b) - begin;
    if (bad >= 0)
        return sbi_fail_element(&info->error, SB_ERROR_INVERTED, bad,
                                "element %d turned inside out, which its material does not allow", bad);
    return SB_OK;
}

/* Acceleration of a node whose velocity so far is v, when it takes `share` (s) more of it: M a + alpha M (v + share a)
 * = f_ext - f_int. */
static sb_vec3 sbi_explicit_acceleration(const sb_body *b, int i, sb_vec3 v, sb_real share)
{
    sb_vec3 free_of_damping;
    if (!(b->lumped_mass[i] > 0))
        return sb_v3(0, 0, 0);
    free_of_damping = sb_v3_scale(1 / b->lumped_mass[i], sb_v3_sub(b->external[i], b->internal[i]));
    return sb_v3_scale(1 / (1 + b->damping_mass * share), sb_v3_madd(free_of_damping, -b->damping_mass, v));
}

/* Accelerations under the present loads. Supported axes run evenly to their targets through the whole call: their
 * velocity jumps at its start, which may bring energy in, and their acceleration is the mean that this amounts to. */
static void sbi_explicit_begin(sb_body *b, sb_real dt)
{
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 v = b->velocity[i], a = sbi_explicit_acceleration(b, i, v, 0);
        if (b->fixed[i]) {
            sb_vec3 rate = sb_v3_scale(1 / dt, sb_v3_sub(b->target[i], b->start[i]));
            sb_vec3 change = sb_v3_scale(1 / dt, sb_v3_sub(rate, v));
            b->velocity[i] = sbi_body_pick_axes(b->fixed[i], rate, v);
            a = sbi_body_pick_axes(b->fixed[i], change, a);
            b->guard.energy += 0.5 * (double)b->lumped_mass[i] *
                               (double)sb_max(0, sb_v3_dot(b->velocity[i], b->velocity[i]) - sb_v3_dot(v, v));
        }
        b->acceleration[i] = a;
    }
}

/* Displacements a substep of h on, `done` of the call's way for supports; moves in increment. Returns the work (J) of
 * loads and, at the forces before, half of that of supports. */
static double sbi_explicit_move(sb_body *b, sb_real h, sb_real done)
{
    const sb_vec3 zero = sb_v3(0, 0, 0);
    double work = 0;
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 half = sb_v3_madd(b->velocity[i], h / 2, b->acceleration[i]);
        sb_vec3 next = sb_v3_madd(b->displacement[i], h, half), go;
        if (b->fixed[i]) {
            sb_vec3 goal = b->target[i];
            if (done < 1)
                goal = sb_v3_madd(b->start[i], done, sb_v3_sub(goal, b->start[i]));
            next = sbi_body_pick_axes(b->fixed[i], goal, next);
        }
        go = sb_v3_sub(next, b->displacement[i]);
        work += (double)sb_v3_dot(b->external[i], sbi_body_pick_axes(b->fixed[i], zero, go)) +
                0.5 * (double)sb_v3_dot(b->internal[i], sbi_body_pick_axes(b->fixed[i], go, zero));
        b->increment[i] = go;
        b->displacement[i] = next;
    }
    b->force_current = 0;
    return work;
}

/* Velocities and accelerations at the end of the substep. Returns the other half of the work of supports. */
static double sbi_explicit_accelerate(sb_body *b, sb_real h)
{
    const sb_vec3 zero = sb_v3(0, 0, 0);
    double work = 0;
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 half = sb_v3_madd(b->velocity[i], h / 2, b->acceleration[i]);
        sb_vec3 a = sbi_explicit_acceleration(b, i, half, h / 2);
        work += 0.5 * (double)sb_v3_dot(b->internal[i], sbi_body_pick_axes(b->fixed[i], b->increment[i], zero));
        b->velocity[i] = sbi_body_pick_axes(b->fixed[i], b->velocity[i], sb_v3_madd(half, h / 2, a));
        b->acceleration[i] = sbi_body_pick_axes(b->fixed[i], b->acceleration[i], a);
    }
    return work;
}

/* One substep of h. A step that has gone bad shows in its kinetic energy, which is cheap to look at. */
static sb_result sbi_explicit_substep(const sbi_explicit *x, sb_real h, sb_real done)
{
    sb_body *b = x->body;
    double work = sbi_explicit_move(b, h, done);
    sb_result result = sbi_explicit_force(b, x->info);
    if (result != SB_OK)
        return result;
    work += sbi_explicit_accelerate(b, h);
    b->guard.energy += work > 0 ? work : 0;
    b->guard.age++;
    x->info->substeps++;
    return sbi_explicit_audit(x, sbi_explicit_kinetic(b));
}

/* Substeps that are needed for the rest of the way. A thousandth of a substep more or less is rounding. */
static double sbi_explicit_count(sb_real left, sb_real longest)
{
    double count = ceil((double)left / (double)longest - 1e-3);
    return count < 1 ? 1 : count;
}

/* Forces of the supports at the end of the call. */
static void sbi_explicit_reactions(sb_body *b)
{
    const sb_vec3 zero = sb_v3(0, 0, 0);
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 inertia = sb_v3_madd(b->acceleration[i], b->damping_mass, b->velocity[i]);
        sb_vec3 sum = sb_v3_madd(sb_v3_sub(b->internal[i], b->external[i]), b->lumped_mass[i], inertia);
        b->reaction[i] = sbi_body_pick_axes(b->node_component[i] < 0 ? 0 : b->fixed[i], sum, zero);
    }
}

/* All substeps of a call of dt. A shape that needs very short ones may be left soon: only the substeps that were taken
 * count against the cap. */
static sb_result sbi_explicit_go(sbi_explicit *x, sb_real dt)
{
    sb_body *b = x->body;
    sb_real left = dt;
    while (left > 0) {
        sb_result result = SB_OK;
        double count;
        sb_real h;
        if (!(b->guard.stable_step > 0) || b->guard.age >= x->plan->interval)
            result = sbi_explicit_look(x);
        if (result != SB_OK)
            return result;
        if (x->info->substeps == b->max_substeps)
            return sbi_fail(&x->info->error, SB_ERROR_NOT_CONVERGED,
                            "dt %g s takes more than max_substeps %d: the stable step is %g s", (double)dt,
                            b->max_substeps, (double)b->guard.stable_step);
        count = sbi_explicit_count(left, x->plan->margin * b->guard.stable_step);
        h = (sb_real)((double)left / count);
        left = count > 1 ? left - h : 0;
        result = sbi_explicit_substep(x, h, 1 - left / dt);
        if (result != SB_OK)
            return result;
    }
    return x->last_resort ? sbi_explicit_look(x) : SB_OK;
}

SBI_API void sbi_explicit_calm(sb_body *body, int caution)
{
    sbi_step_guard *guard = &body->guard;
    guard->calm = caution == guard->caution ? guard->calm + 1 : 1;
    guard->caution = caution;
    if (guard->calm >= 8 && caution > 0) {
        guard->caution--;
        guard->calm = 0;
    }
}

SBI_API sb_result sbi_explicit_run(sb_body *body, sb_real dt, int caution, sb_step_info *info)
{
    sbi_explicit x;
    sb_result result;
    x.body = body;
    x.info = info;
    x.plan = sbi_explicit_plans + caution;
    x.last_resort = caution == SBI_EXPLICIT_CAUTION;
    x.start_energy = 0;
    info->substeps = 0;
    if (!body->acceleration_known) /* the state came from outside */
        memset(&body->guard, 0, sizeof body->guard);
    if (caution > 0)
        body->guard.stable_step = 0;
    result = sbi_explicit_force(body, info);
    if (result != SB_OK)
        return result;
    sbi_explicit_begin(body, dt);
    result = sbi_explicit_go(&x, dt);
    if (result != SB_OK)
        return result;
    sbi_explicit_reactions(body);
    sbi_body_update_positions(body);
    body->acceleration_known = 1;
    return SB_OK;
}

/* ==== src/softbody/step.c ==== */
/* step: one Newton driver for time steps and static solves.
 *
 * Both solve r(u) = M a + D v + f_int(u) - f_ext = 0 with a = ca (u - start) + a0 and v = cv (u - start) + v0;
 * a static solve has ca = cv = 0. So A = dr/du = (ca + alpha cv) M + (1 + beta cv) K, and one iteration is
 * A du = -r. */

#include <string.h>


typedef struct sbi_newton {
    sb_body *body;
    sb_step_info *info;
    int dynamic;
    sb_real cv, ca;           /* dv/du (1/s) and da/du (1/s^2) */
    sb_real dt;
    sb_real load_factor;      /* share of the way from start to target the supports go */
    sb_real level;            /* share of the step after which u, v and the forces balance: 1, or 1 - alpha_f */
    sb_real inertia_level;    /* the same for a: 1, or 1 - alpha_m */
    sb_real radius;           /* spectral radius of generalised alpha */
    sb_real tolerance;        /* of the residual; a linearised step has none */
    sb_real linear_tolerance; /* of the linear solves; adaptive when 0 */
    int max_newton, max_iterations;
    int line_search;
    int linearised;           /* one iteration, taken as it is */
    int lagged_damping;       /* D's K is the one at the start of the step, in body->damping_blocks; a linearised step
                               * has it in A already */
    int has_velocity;         /* v may differ from 0 at the current u */
    int moves_supports;       /* the present increment moves supported nodes */
    sb_real scale;            /* largest force (N), to compare residuals with */
    sb_real norm, last_norm;  /* residual on free axes (N), now and one iteration ago */
    sb_real energy;           /* elastic, at the current u; valid when energy_known */
    int energy_known;
    int cautious;             /* 1: the last increment had to be cut short, so project the next tangent */
} sbi_newton;

/* ---- small vector loops ---- */

static double sbi_step_now(const sb_body *body) { return body->clock ? body->clock() : 0.0; }

static sb_real sbi_step_dot(const sb_vec3 *a, const sb_vec3 *b, int count)
{
    double sum = 0;
    for (int i = 0; i < count; i++)
        sum += (double)a[i].x * (double)b[i].x + (double)a[i].y * (double)b[i].y + (double)a[i].z * (double)b[i].z;
    return (sb_real)sum;
}

/* Norm of the components on free (or on fixed) axes. */
static sb_real sbi_step_norm(const sb_body *body, const sb_vec3 *a, int on_fixed)
{
    const sb_vec3 zero = sb_v3(0, 0, 0);
    double sum = 0;
    for (int i = 0; i < body->domain.node_count; i++) {
        sb_vec3 v = on_fixed ? sbi_body_pick_axes(body->fixed[i], a[i], zero)
                             : sbi_body_pick_axes(body->fixed[i], zero, a[i]);
        sum += (double)v.x * (double)v.x + (double)v.y * (double)v.y + (double)v.z * (double)v.z;
    }
    return sb_sqrt((sb_real)sum);
}

static sb_vec3 sbi_step_velocity(const sbi_newton *newton, int i)
{
    const sb_body *b = newton->body;
    return sb_v3_madd(b->velocity0[i], newton->cv, sb_v3_sub(b->displacement[i], b->start[i]));
}

static sb_vec3 sbi_step_acceleration(const sbi_newton *newton, int i)
{
    const sb_body *b = newton->body;
    return sb_v3_madd(b->acceleration0[i], newton->ca, sb_v3_sub(b->displacement[i], b->start[i]));
}

/* ---- one Newton iteration: residual ---- */

static sb_result sbi_newton_force(sbi_newton *newton)
{
    sb_body *b = newton->body;
    double begin = sbi_step_now(b);
    int bad = -1;
    if (!b->force_current) {
        bad = sbi_assembly_force(&b->assembly, b->displacement, b->internal);
        b->force_current = bad < 0;
    }
    newton->info->seconds_force += sbi_step_now(b) - begin;
    if (bad >= 0)
        return sbi_fail_element(&newton->info->error, SB_ERROR_INVERTED, bad,
                                "element %d is inside out, which its material does not allow", bad);
    return SB_OK;
}

static sb_real sbi_newton_mass_factor(const sbi_newton *newton)
{
    return newton->dynamic ? newton->ca + newton->body->damping_mass * newton->cv : 0;
}

/* Share of the assembled stiffness in A: damping is part of it in a linearised step. */
static sb_real sbi_newton_stiffness_factor(const sbi_newton *newton)
{
    return newton->dynamic && !newton->lagged_damping ? 1 + newton->body->damping_stiffness * newton->cv : 1;
}

/* The body's matrix with the damping stiffness in place of the tangent; borrowed. */
static sb_matrix sbi_newton_damping_matrix(const sb_body *b)
{
    sb_matrix matrix = b->matrix;
    matrix.blocks = b->damping_blocks;
    return matrix;
}

/* matrix = A at the present displacement, whose forces are current. */
static void sbi_newton_tangent(sbi_newton *newton, sb_tangent_kind kind)
{
    sb_body *b = newton->body;
    double begin = sbi_step_now(b);
    sbi_assembly_tangent(&b->assembly, b->displacement, kind, sbi_newton_stiffness_factor(newton), &b->matrix);
    if (newton->dynamic)
        sbi_body_add_mass(b, sbi_newton_mass_factor(newton));
    if (newton->lagged_damping) {
        sb_real factor = b->damping_stiffness * newton->cv;
        for (int k = 0; k < b->matrix.block_count; k++)
            for (int c = 0; c < 9; c++)
                b->matrix.blocks[k][c] += factor * b->damping_blocks[k][c];
    }
    newton->info->seconds_tangent += sbi_step_now(b) - begin;
}

/* Keeps the stiffness at the start of the step for D. Were it to follow the iterations, the step would have no
 * potential to go down, and an indefinite or suddenly larger K would feed energy in. */
static sb_result sbi_newton_keep_damping(sbi_newton *newton)
{
    sb_body *b = newton->body;
    double begin;
    sb_result result = sbi_newton_force(newton);
    if (result != SB_OK)
        return result;
    begin = sbi_step_now(b);
    sbi_assembly_tangent(&b->assembly, b->displacement, SB_TANGENT_SPD, 1, &b->matrix);
    memcpy(b->damping_blocks, b->matrix.blocks, (size_t)b->matrix.block_count * sizeof b->matrix.blocks[0]);
    newton->info->seconds_tangent += sbi_step_now(b) - begin;
    newton->lagged_damping = 1;
    return SB_OK;
}

/* out = K x with the K of D. In a linearised step it comes from A = cm M + ck K, which is assembled by then. */
static void sbi_newton_damping_product(const sbi_newton *newton, const sb_vec3 *x, sb_vec3 *out)
{
    sb_body *b = newton->body;
    sb_matrix damping = sbi_newton_damping_matrix(b);
    sb_real mass = sbi_newton_mass_factor(newton), stiffness = (sb_real)1 / sbi_newton_stiffness_factor(newton);
    if (newton->lagged_damping) {
        sb_matrix_multiply(&damping, &x[0].x, &out[0].x, &b->jobs);
        return;
    }
    sb_matrix_multiply(&b->matrix, &x[0].x, &out[0].x, &b->jobs);
    sbi_body_mass_multiply(b, x, b->work2);
    for (int i = 0; i < b->domain.node_count; i++)
        out[i] = sb_v3_scale(stiffness, sb_v3_madd(out[i], -mass, b->work2[i]));
}

/* residual += M (a + alpha v) + beta K v. */
static void sbi_newton_add_dynamics(sbi_newton *newton)
{
    sb_body *b = newton->body;
    int n = b->domain.node_count;
    for (int i = 0; i < n; i++)
        b->work[i] = sb_v3_madd(sbi_step_acceleration(newton, i), b->damping_mass, sbi_step_velocity(newton, i));
    sbi_body_mass_multiply(b, b->work, b->work2);
    for (int i = 0; i < n; i++)
        b->residual[i] = sb_v3_add(b->residual[i], b->work2[i]);
    newton->scale = sb_max(newton->scale, sb_sqrt(sbi_step_dot(b->work2, b->work2, n)));
    if (!(b->damping_stiffness > 0) || !newton->has_velocity)
        return;
    for (int i = 0; i < n; i++)
        b->work[i] = sbi_step_velocity(newton, i);
    sbi_newton_damping_product(newton, b->work, b->rhs);
    for (int i = 0; i < n; i++)
        b->residual[i] = sb_v3_madd(b->residual[i], b->damping_stiffness, b->rhs[i]);
}

/* residual = r(u), its norm on the free axes, and the force to compare it with. */
static void sbi_newton_residual(sbi_newton *newton)
{
    sb_body *b = newton->body;
    int n = b->domain.node_count;
    for (int i = 0; i < n; i++)
        b->residual[i] = sb_v3_sub(b->internal[i], b->external[i]);
    newton->scale = sb_max(sb_sqrt(sbi_step_dot(b->external, b->external, n)), sbi_step_norm(b, b->internal, 1));
    if (newton->dynamic) {
        newton->scale = sb_max(newton->scale, sb_sqrt(sbi_step_dot(b->internal, b->internal, n)));
        sbi_newton_add_dynamics(newton);
    }
    newton->last_norm = newton->norm;
    newton->norm = sbi_step_norm(b, b->residual, 0);
}

/* ---- one Newton iteration: linear solve ---- */

/* Where the supports of node i should be at the present load factor; exact at the end of the way. */
static sb_vec3 sbi_newton_goal(const sbi_newton *newton, int i)
{
    const sb_body *b = newton->body;
    if (newton->load_factor == 1)
        return b->target[i];
    return sb_v3_madd(b->start[i], newton->load_factor, sb_v3_sub(b->target[i], b->start[i]));
}

/* What supported axes of node i still have to go. */
static sb_vec3 sbi_newton_way_to_go(const sbi_newton *newton, int i)
{
    const sb_body *b = newton->body;
    return sbi_body_pick_axes(b->fixed[i], sb_v3_sub(sbi_newton_goal(newton, i), b->displacement[i]), sb_v3(0, 0, 0));
}

static int sbi_newton_supports_move(const sbi_newton *newton)
{
    const sb_body *b = newton->body;
    for (int i = 0; i < b->domain.node_count; i++)
        if (b->fixed[i]) {
            sb_vec3 go = sbi_newton_way_to_go(newton, i);
            if (go.x != 0 || go.y != 0 || go.z != 0)
                return 1;
        }
    return 0;
}

/* Start of the linear solve: what the motion predicts on free axes, the way still to go on supported ones. */
static void sbi_newton_predict(sbi_newton *newton, int first)
{
    sb_body *b = newton->body;
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 coast = sb_v3(0, 0, 0);
        if (first && newton->dynamic)
            coast = sb_v3_scale(newton->level * newton->dt, b->velocity[i]);
        b->increment[i] = sbi_body_pick_axes(b->fixed[i], sbi_newton_way_to_go(newton, i), coast);
    }
}

/* Keeps the rows of supported nodes, which the reactions need, before they are masked. */
static void sbi_newton_keep_support_rows(sb_body *b)
{
    const sb_matrix *matrix = &b->matrix;
    sb_real(*out)[9] = b->support_blocks;
    for (int i = 0; i < matrix->row_count; i++)
        if (b->fixed[i] && b->node_component[i] >= 0) {
            int count = matrix->row_start[i + 1] - matrix->row_start[i];
            memcpy(out, matrix->blocks + matrix->row_start[i], (size_t)count * sizeof *out);
            out += count;
        }
}

/* Reactions: r on supported axes. Of a linearised step r + A du, since its r is the one before du. */
static void sbi_newton_reactions(const sbi_newton *newton)
{
    sb_body *b = newton->body;
    const sb_matrix *matrix = &b->matrix;
    const sb_real(*row)[9] = (const sb_real(*)[9])b->support_blocks;
    const sb_vec3 zero = sb_v3(0, 0, 0);
    for (int i = 0; i < matrix->row_count; i++) {
        sb_vec3 sum = b->residual[i];
        b->reaction[i] = zero;
        if (!b->fixed[i] || b->node_component[i] < 0)
            continue;
        for (int k = matrix->row_start[i]; newton->linearised && k < matrix->row_start[i + 1]; k++, row++) {
            sb_vec3 d = b->increment[matrix->columns[k]];
            const sb_real *m = *row;
            sum = sb_v3_add(sum, sb_v3(m[0] * d.x + m[1] * d.y + m[2] * d.z, m[3] * d.x + m[4] * d.y + m[5] * d.z,
                                       m[6] * d.x + m[7] * d.y + m[8] * d.z));
        }
        b->reaction[i] = sbi_body_pick_axes(b->fixed[i], sum, zero);
    }
}

/* Tolerance of this iteration's linear solve. A linearised step has its own; otherwise it tightens with Newton's
 * progress (Eisenstat and Walker 1996, choice 2), never beyond what the residual's tolerance can notice. */
static sb_real sbi_newton_linear_tolerance(const sbi_newton *newton, int iteration)
{
    const sb_body *b = newton->body;
    sb_real least = 10 * SB_EPSILON, enough = least, forcing = (sb_real)1e-2;
    int linear = 1;
    if (newton->linear_tolerance > 0)
        return newton->linear_tolerance;
    for (int i = 0; i < b->material_count; i++)
        linear = linear && sb_material_is_linear(b->materials[i].model);
    if (newton->norm > 0)
        enough = (sb_real)0.1 * newton->tolerance * newton->scale / newton->norm;
    if (linear)
        return sb_max(sb_min((sb_real)0.1 * newton->tolerance, enough), least);
    if (iteration > 0 && newton->last_norm > 0) {
        sb_real ratio = newton->norm / newton->last_norm;
        forcing = sb_min(forcing, (sb_real)0.5 * ratio * ratio);
    }
    return sb_max(sb_max(forcing, sb_min(enough, (sb_real)1e-2)), least);
}

/* Solves A du = -r with the supports' increments prescribed. */
static sb_result sbi_newton_solve(sbi_newton *newton, int iteration)
{
    sb_body *b = newton->body;
    sb_step_info *info = newton->info;
    sb_pcg_options options = sb_default_pcg_options();
    sb_pcg_info pcg = {0, 0, 0, 0, 0};
    sb_result result;
    double begin = sbi_step_now(b), middle;
    sbi_newton_predict(newton, iteration == 0);
    for (int i = 0; i < b->domain.node_count; i++)
        b->rhs[i] = sb_v3_scale(-1, b->residual[i]);
    sbi_newton_keep_support_rows(b);
    sb_matrix_constrain(&b->matrix, b->fixed, &b->increment[0].x, &b->rhs[0].x);
    result = sb_preconditioner_update(b->precond, &b->matrix, b->position, &info->error);
    middle = sbi_step_now(b);
    info->seconds_precond += middle - begin;
    if (result != SB_OK)
        return result;
    options.tolerance = (double)sbi_newton_linear_tolerance(newton, iteration);
    options.max_iterations = newton->max_iterations;
    options.jobs = &b->jobs;
    result = sb_pcg_solve(&b->matrix, b->precond, &b->rhs[0].x, &b->increment[0].x, &options, &b->pcg, &pcg);
    info->seconds_solve += sbi_step_now(b) - middle;
    info->pcg_iterations += pcg.iterations;
    info->newton_iterations++;
    if (newton->linearised)
        info->residual = (sb_real)pcg.residual;
    if (result == SB_ERROR_NOT_CONVERGED) { /* still the best increment so far: use it */
        info->capped |= pcg.capped;
        result = SB_OK;
    }
    return result;
}

/* ---- one Newton iteration: line search ---- */

/* Potential along du without the elastic energy: t * linear + t^2 * quadratic, from inertia, damping and loads. */
typedef struct sbi_newton_line {
    sb_real slope;      /* r . du, what Armijo asks a share of */
    sb_real linear, quadratic;
} sbi_newton_line;

static sbi_newton_line sbi_newton_make_line(sbi_newton *newton)
{
    sb_body *b = newton->body;
    int n = b->domain.node_count;
    sbi_newton_line line = {0, 0, 0};
    line.slope = sbi_step_dot(b->residual, b->increment, n);
    line.linear = line.slope - sbi_step_dot(b->internal, b->increment, n);
    if (newton->dynamic) {
        sbi_body_mass_multiply(b, b->increment, b->work);
        line.quadratic = sbi_newton_mass_factor(newton) * sbi_step_dot(b->increment, b->work, n);
        if (newton->lagged_damping) {
            sbi_newton_damping_product(newton, b->increment, b->work);
            line.quadratic += b->damping_stiffness * newton->cv * sbi_step_dot(b->increment, b->work, n);
        }
        line.quadratic *= (sb_real)0.5;
    }
    return line;
}

/* Displacement for a share t of the increment, in work2. A whole increment puts the supports where they belong to
 * the last bit, so that no rounding error keeps them on the way. */
static void sbi_newton_trial(const sbi_newton *newton, sb_real t)
{
    const sb_body *b = newton->body;
    for (int i = 0; i < b->domain.node_count; i++) {
        b->work2[i] = sb_v3_madd(b->displacement[i], t, b->increment[i]);
        if (t == 1 && b->fixed[i])
            b->work2[i] = sbi_body_pick_axes(b->fixed[i], sbi_newton_goal(newton, i), b->work2[i]);
    }
}

/* Elastic energy of a trial displacement; 0 when it is inadmissible, with *bad the element that is. */
static int sbi_newton_try(sbi_newton *newton, const sb_vec3 *trial, sb_real *energy, int *bad)
{
    *bad = sbi_assembly_energy(&newton->body->assembly, trial, energy);
    return *bad < 0 && sb_is_finite(*energy);
}

static void sbi_newton_take(sbi_newton *newton, const sb_vec3 *trial, sb_real energy)
{
    sb_body *b = newton->body;
    memcpy(b->displacement, trial, (size_t)b->domain.node_count * sizeof(sb_vec3));
    newton->energy = energy;
    newton->energy_known = 1;
}

static sb_result sbi_newton_no_step(sbi_newton *newton, int bad)
{
    if (bad >= 0)
        return sbi_fail_element(&newton->info->error, SB_ERROR_INVERTED, bad,
                                "element %d would turn inside out however short the step", bad);
    return sbi_fail(&newton->info->error, SB_ERROR_DIVERGED, "no step along the search direction lowers the energy");
}

/* While supports move, work comes in through them and no energy has to fall: the longest admissible share of the
 * increment is taken. In a time step the increment may be far off, when a tool jumps by more than an element; then
 * the supports alone move if that costs less, and the next iterations bring the rest along. */
static sb_result sbi_newton_move_supports(sbi_newton *newton)
{
    sb_body *b = newton->body;
    sb_real energy = 0, alone = 0, t;
    int bad = -1;
    for (t = 1; t > (sb_real)1e-6; t *= (sb_real)0.5) {
        sbi_newton_trial(newton, t);
        if (sbi_newton_try(newton, b->work2, &energy, &bad))
            break;
    }
    if (newton->dynamic && (t < 1 || energy > 0)) {
        for (int i = 0; i < b->domain.node_count; i++)
            b->work[i] = sbi_body_pick_axes(b->fixed[i], sbi_newton_goal(newton, i), b->displacement[i]);
        if (sbi_newton_try(newton, b->work, &alone, &bad) && (t < 1 || alone < energy)) {
            sbi_newton_take(newton, b->work, alone);
            return SB_OK;
        }
    }
    if (!(t > (sb_real)1e-6))
        return sbi_newton_no_step(newton, bad);
    sbi_newton_take(newton, b->work2, energy);
    return SB_OK;
}

/* Takes the first share t = 1, 1/2, 1/4 ... of the increment whose shape is admissible and whose potential fell
 * enough (Armijo). */
static sb_result sbi_newton_search(sbi_newton *newton)
{
    sb_body *b = newton->body;
    sbi_newton_line line;
    int bad = -1;
    if (!newton->energy_known && !sbi_newton_try(newton, b->displacement, &newton->energy, &bad))
        return sbi_newton_no_step(newton, bad);
    newton->energy_known = 1;
    line = sbi_newton_make_line(newton);
    if (!(line.slope < 0))
        return SB_ERROR_INDEFINITE;
    for (sb_real t = 1; t > (sb_real)1e-6; t *= (sb_real)0.5) {
        sb_real energy, change, noise;
        sbi_newton_trial(newton, t);
        if (!sbi_newton_try(newton, b->work2, &energy, &bad))
            continue;
        change = energy - newton->energy + t * line.linear + t * t * line.quadratic;
        noise = 32 * SB_EPSILON * (sb_abs(energy) + sb_abs(newton->energy) + sb_abs(t * line.linear)) +
                4 * SB_EPSILON * b->assembly.energy_unit;
        if (change <= (sb_real)1e-4 * t * line.slope + noise) {
            sbi_newton_take(newton, b->work2, energy);
            newton->cautious = t < 1;
            return SB_OK;
        }
    }
    return sbi_newton_no_step(newton, bad);
}

static sb_result sbi_newton_accept(sbi_newton *newton)
{
    sb_body *b = newton->body;
    sb_result result = SB_OK;
    if (newton->line_search) {
        result = newton->moves_supports ? sbi_newton_move_supports(newton) : sbi_newton_search(newton);
    } else {
        sbi_newton_trial(newton, 1);
        memcpy(b->displacement, b->work2, (size_t)b->domain.node_count * sizeof(sb_vec3));
    }
    if (result != SB_OK)
        return result;
    for (int i = 0; i < b->domain.node_count; i++)
        if (!sb_v3_is_finite(b->displacement[i]))
            return sbi_fail_node(&newton->info->error, SB_ERROR_DIVERGED, i, "the displacement of node %d is not finite",
                                 i);
    b->force_current = 0;
    newton->has_velocity = 1;
    return SB_OK;
}

/* 1 when the increment is below what the displacement's digits can show: nothing is left to gain. */
static int sbi_newton_is_exhausted(const sb_body *b)
{
    sb_real largest = 0, size = 0;
    for (int i = 0; i < b->domain.node_count; i++) {
        largest = sb_max(largest, sb_v3_dot(b->increment[i], b->increment[i]));
        size = sb_max(size, sb_v3_dot(b->displacement[i], b->displacement[i]));
    }
    return largest <= 16 * SB_EPSILON * SB_EPSILON * size;
}

/* ---- the Newton loop ---- */

/* One iteration with the given tangent; SB_ERROR_INDEFINITE asks for a projected one. */
static sb_result sbi_newton_iterate(sbi_newton *newton, int iteration, sb_tangent_kind kind)
{
    sb_result result = sbi_newton_solve(newton, iteration);
    if (result == SB_OK)
        result = sbi_newton_accept(newton);
    if (result == SB_ERROR_INDEFINITE && kind != SB_TANGENT_EXACT)
        return sbi_fail(&newton->info->error, result, "the projected tangent is not positive definite: %s",
                        newton->moves_supports ? "supports move too far in one step" : "is the body supported?");
    return result;
}

/* The exact tangent where its convergence pays. Far from the solution its directions are poor, which shows in short
 * increments; and while a time step still moves supports, no line search watches the increment, so that the tangent
 * must be safe by itself. */
static sb_tangent_kind sbi_newton_first_kind(const sbi_newton *newton)
{
    return newton->cautious || (newton->dynamic && newton->moves_supports) ? SB_TANGENT_SPD : SB_TANGENT_EXACT;
}

/* Forces, residual, and the tangent of a linearised step. */
static sb_result sbi_newton_evaluate(sbi_newton *newton)
{
    sb_result result = sbi_newton_force(newton);
    if (result != SB_OK)
        return result;
    newton->moves_supports = sbi_newton_supports_move(newton);
    if (newton->linearised) /* its residual may need K v */
        sbi_newton_tangent(newton, SB_TANGENT_QUASI);
    sbi_newton_residual(newton);
    if (!sb_is_finite(newton->norm))
        return sbi_fail(&newton->info->error, SB_ERROR_DIVERGED, "the forces are not finite");
    return SB_OK;
}

/* 1 when the residual is small enough, or as small as rounding lets it become. */
static int sbi_newton_is_converged(sbi_newton *newton, int iteration)
{
    newton->info->residual = newton->scale > 0 ? newton->norm / newton->scale : 0;
    if (newton->moves_supports)
        return 0;
    if (newton->norm <= newton->tolerance * newton->scale)
        return 1;
    return iteration > 0 && (newton->norm <= 16 * SB_EPSILON * newton->body->force_unit ||
                             sbi_newton_is_exhausted(newton->body));
}

static int sbi_newton_allows_inversion(const sb_body *b)
{
    for (int i = 0; i < b->material_count; i++)
        if (!sb_material_allows_inversion(b->materials[i].model))
            return 0;
    return 1;
}

/* The one iteration of a linearised step. Nothing watches its increment, so where the material forbids inverted
 * elements the new shape is tried at once (the next step finds its forces done): the body must stay steppable. */
static sb_result sbi_newton_linearised(sbi_newton *newton)
{
    sb_result result = sbi_newton_iterate(newton, 0, SB_TANGENT_QUASI);
    if (result == SB_OK && !sbi_newton_allows_inversion(newton->body))
        result = sbi_newton_force(newton);
    return result;
}

/* Iterates to r(u) = 0 (or once, for a linearised step). The displacement is moved; the caller undoes failures. */
static sb_result sbi_newton_run(sbi_newton *newton)
{
    for (int iteration = 0;; iteration++) {
        sb_tangent_kind kind;
        sb_result result = sbi_newton_evaluate(newton);
        if (result != SB_OK)
            return result;
        if (newton->linearised)
            return sbi_newton_linearised(newton);
        if (sbi_newton_is_converged(newton, iteration))
            return SB_OK;
        if (iteration == newton->max_newton)
            return SB_ERROR_NOT_CONVERGED;
        kind = sbi_newton_first_kind(newton);
        sbi_newton_tangent(newton, kind);
        result = sbi_newton_iterate(newton, iteration, kind);
        if (result == SB_ERROR_INDEFINITE && kind == SB_TANGENT_EXACT) {
            sbi_newton_tangent(newton, SB_TANGENT_SPD);
            result = sbi_newton_iterate(newton, iteration, SB_TANGENT_SPD);
        }
        if (result != SB_OK)
            return result;
    }
}

/* ---- time steps ---- */

static void sbi_step_loads(sb_body *b)
{
    for (int i = 0; i < b->domain.node_count; i++)
        b->work[i] = b->gravity;
    sbi_body_mass_multiply(b, b->work, b->external);
    for (int i = 0; i < b->domain.node_count; i++)
        b->external[i] = sb_v3_add(b->external[i], b->dead_load[i]);
}

/* M a = f_ext - f_int - D v: what Newmark starts from. Supported nodes start without acceleration. */
static sb_result sbi_step_initial_acceleration(sbi_newton *newton)
{
    sb_body *b = newton->body;
    sb_result result = sbi_newton_force(newton);
    sbi_newton start = *newton;
    int n = b->domain.node_count;
    if (result != SB_OK)
        return result;
    start.cv = start.ca = 0;
    start.linear_tolerance = 100 * SB_EPSILON;
    start.max_iterations = sbi_max_int(newton->max_iterations, 1000);
    memcpy(b->velocity0, b->velocity, (size_t)n * sizeof(sb_vec3));
    memset(b->acceleration0, 0, (size_t)n * sizeof(sb_vec3));
    start.has_velocity = 1;
    if (!start.lagged_damping)
        sbi_newton_tangent(&start, SB_TANGENT_QUASI);
    sbi_newton_residual(&start);
    sb_matrix_clear(&b->matrix);
    sbi_body_add_mass(b, 1);
    start.dynamic = 0;
    start.load_factor = 0;
    result = sbi_newton_solve(&start, 0);
    if (result == SB_OK)
        memcpy(b->acceleration, b->increment, (size_t)n * sizeof(sb_vec3));
    if (result != SB_ERROR_INDEFINITE || b->mass_kind != SB_MASS_REDUCED)
        return result;
    for (int i = 0; i < n; i++) /* a reduced mass may be singular: its lumped sister is not */
        b->acceleration[i] = sbi_body_pick_axes(b->fixed[i], sb_v3(0, 0, 0),
                                                sb_v3_scale(-1 / b->lumped_mass[i], b->residual[i]));
    return SB_OK;
}

/* Generalised alpha (Chung and Hulbert 1993) in the unknown u at the level 1 - alpha_f of the step: with
 * d = (u - start) / level the Newmark rules give a' and v' at its end, and
 *     v = level v' + (1 - level) v_n,  a = inertia_level a' + (1 - inertia_level) a_n. */
static void sbi_step_scheme_alpha(sbi_newton *newton)
{
    sb_body *b = newton->body;
    sb_real dt = newton->dt, r = newton->radius, level = 1 / (1 + r), inertia = (2 - r) / (1 + r);
    sb_real gamma = inertia - level + (sb_real)0.5, beta = (1 + inertia - level) * (1 + inertia - level) / 4;
    newton->level = newton->load_factor = level;
    newton->inertia_level = inertia;
    newton->cv = gamma / (beta * dt);
    newton->ca = inertia / (beta * dt * dt * level);
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 v = b->velocity[i], a = b->acceleration[i];
        sb_vec3 v0 = sb_v3_madd(sb_v3_scale(1 - level * gamma / beta, v), level * dt * (1 - gamma / (2 * beta)), a);
        sb_vec3 a0 = sb_v3_madd(sb_v3_scale(1 - inertia / (2 * beta), a), -inertia / (beta * dt), v);
        if (b->fixed[i]) {
            sb_vec3 go = sb_v3_sub(b->target[i], b->start[i]), rate = sb_v3_scale(1 / dt, go);
            sb_vec3 change = sb_v3_scale(1 / dt, sb_v3_sub(rate, v));
            sb_vec3 rate_now = sb_v3_madd(sb_v3_scale(1 - level, v), level, rate);
            sb_vec3 change_now = sb_v3_madd(sb_v3_scale(1 - inertia, a), inertia, change);
            v0 = sbi_body_pick_axes(b->fixed[i], sb_v3_madd(rate_now, -newton->cv * level, go), v0);
            a0 = sbi_body_pick_axes(b->fixed[i], sb_v3_madd(change_now, -newton->ca * level, go), a0);
        }
        b->velocity0[i] = v0;
        b->acceleration0[i] = a0;
    }
    newton->has_velocity = 1;
}

/* Coefficients and predictors of the integrator. Supported axes move evenly to their targets. */
static void sbi_step_scheme(sbi_newton *newton)
{
    sb_body *b = newton->body;
    sb_real dt = newton->dt;
    int newmark = b->integrator == SB_NEWMARK;
    newton->cv = (newmark ? 2 : 1) / dt;
    newton->ca = (newmark ? 4 : 1) / (dt * dt);
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 v = b->velocity[i], v0 = sb_v3(0, 0, 0), a0 = sb_v3_scale(-1 / dt, v);
        if (newmark) {
            v0 = sb_v3_scale(-1, v);
            a0 = sb_v3_sub(sb_v3_scale(-4 / dt, v), b->acceleration[i]);
        }
        if (b->fixed[i]) {
            sb_vec3 go = sb_v3_sub(b->target[i], b->start[i]), rate = sb_v3_scale(1 / dt, go);
            sb_vec3 change = sb_v3_scale(1 / dt, sb_v3_sub(rate, v));
            v0 = sbi_body_pick_axes(b->fixed[i], sb_v3_madd(rate, -newton->cv, go), v0);
            a0 = sbi_body_pick_axes(b->fixed[i], sb_v3_madd(change, -newton->ca, go), a0);
        }
        b->velocity0[i] = v0;
        b->acceleration0[i] = a0;
    }
    newton->has_velocity = newmark;
}

/* What a failing step gives back, and where it is kept meanwhile. */
typedef struct sbi_step_pair {
    sb_vec3 *state, *saved;
} sbi_step_pair;

enum { SBI_STEP_PAIRS = 6 };

static void sbi_step_pairs(sb_body *b, sbi_step_pair pairs[SBI_STEP_PAIRS])
{
    sb_vec3 *const state[SBI_STEP_PAIRS] = {b->displacement, b->velocity, b->acceleration,
                                            b->reaction,     b->external, b->internal};
    sb_vec3 *const saved[SBI_STEP_PAIRS] = {b->start,          b->saved_velocity, b->saved_acceleration,
                                            b->saved_reaction, b->saved_external, b->saved_internal};
    for (int i = 0; i < SBI_STEP_PAIRS; i++) {
        pairs[i].state = state[i];
        pairs[i].saved = saved[i];
    }
}

static void sbi_step_save(sb_body *b)
{
    sbi_step_pair pairs[SBI_STEP_PAIRS];
    sbi_step_pairs(b, pairs);
    for (int i = 0; i < SBI_STEP_PAIRS; i++)
        memcpy(pairs[i].saved, pairs[i].state, (size_t)b->domain.node_count * sizeof(sb_vec3));
    b->saved_force_current = b->force_current;
    sbi_assembly_save_rotations(&b->assembly);
}

static void sbi_step_undo(sb_body *b)
{
    sbi_step_pair pairs[SBI_STEP_PAIRS];
    sbi_step_pairs(b, pairs);
    for (int i = 0; i < SBI_STEP_PAIRS; i++)
        memcpy(pairs[i].state, pairs[i].saved, (size_t)b->domain.node_count * sizeof(sb_vec3));
    b->force_current = b->saved_force_current;
    sbi_assembly_restore_rotations(&b->assembly);
    sbi_body_update_positions(b);
}

/* The value at the end of the step of what was `before` at its start and is `now` at the level of balance. */
static sb_vec3 sbi_step_extrapolate(sb_vec3 before, sb_vec3 now, sb_real level)
{
    return sb_v3_madd(before, 1 / level, sb_v3_sub(now, before));
}

/* Moves the displacement on to the end of the step, supports to their targets. No line search has seen that shape,
 * so that it is tried where the material forbids some (the next step finds its forces done). */
static sb_result sbi_step_finish_alpha(sbi_newton *newton)
{
    sb_body *b = newton->body;
    for (int i = 0; i < b->domain.node_count; i++)
        b->displacement[i] =
            sbi_body_pick_axes(b->fixed[i], b->target[i],
                               sbi_step_extrapolate(b->start[i], b->displacement[i], newton->level));
    b->force_current = 0;
    return sbi_newton_allows_inversion(b) ? SB_OK : sbi_newton_force(newton);
}

/* Velocity and acceleration at the new displacement; SB_ERROR_DIVERGED before anything overflows. */
static sb_result sbi_step_commit(sbi_newton *newton)
{
    sb_body *b = newton->body;
    int alpha = b->integrator == SB_GENERALISED_ALPHA;
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 v = sbi_step_velocity(newton, i), a = sbi_step_acceleration(newton, i);
        if (alpha) {
            v = sbi_step_extrapolate(b->velocity[i], v, newton->level);
            a = sbi_step_extrapolate(b->acceleration[i], a, newton->inertia_level);
        }
        if (!sb_v3_is_finite(v) || !sb_v3_is_finite(a))
            return sbi_fail_node(&newton->info->error, SB_ERROR_DIVERGED, i, "the velocity of node %d is not finite",
                                 i);
        b->velocity[i] = v;
        b->acceleration[i] = a;
    }
    if (alpha) {
        sb_result result = sbi_step_finish_alpha(newton);
        if (result != SB_OK)
            return result;
    }
    sbi_body_update_positions(b);
    b->acceleration_known = 1;
    return SB_OK;
}

static void sbi_step_begin_info(sb_step_info *info)
{
    memset(info, 0, sizeof *info);
    info->error.element = -1;
    info->error.node = -1;
}

/* Whether knotted cells get one rotation; forces that were made under the other rule are made anew. */
static void sbi_step_watch_knots(sb_body *b, int unknots)
{
    if (b->assembly.unknots != unknots)
        b->force_current = 0;
    b->assembly.unknots = unknots;
}

static void sbi_step_forget_error(sb_step_info *info)
{
    memset(&info->error, 0, sizeof info->error);
    info->error.element = info->error.node = -1;
}

/* Sees to it that a failing call says why, whatever failed. */
static sb_result sbi_step_report(sb_step_info *info, sb_result result)
{
    if (result != SB_OK && info->error.result != result) {
        if (result == SB_ERROR_NOT_CONVERGED)
            sbi_fail(&info->error, result, "the residual is %g after %d linear solves", (double)info->residual,
                     info->newton_iterations);
        else
            sbi_fail(&info->error, result, "the linear solve failed (%s)", sb_result_string(result));
    }
    return result;
}

static sb_result sbi_step_run(sbi_newton *newton)
{
    sb_body *b = newton->body;
    sb_result result = SB_OK;
    sbi_step_loads(b);
    if (!newton->linearised && b->damping_stiffness > 0)
        result = sbi_newton_keep_damping(newton);
    if (result == SB_OK && b->integrator != SB_EULER && !b->acceleration_known)
        result = sbi_step_initial_acceleration(newton);
    if (result != SB_OK)
        return result;
    if (b->integrator == SB_GENERALISED_ALPHA)
        sbi_step_scheme_alpha(newton);
    else
        sbi_step_scheme(newton);
    newton->info->newton_iterations = newton->info->pcg_iterations = 0;
    result = sbi_newton_run(newton);
    if (result == SB_ERROR_NOT_CONVERGED && !newton->moves_supports) { /* each iteration lowered the potential */
        newton->info->capped = 1;
        result = SB_OK;
    }
    if (result != SB_OK)
        return result;
    sbi_newton_reactions(newton);
    return sbi_step_commit(newton);
}

/* Substeps of central differences; what goes bad is done again with more caution, which stays for a while. */
static sb_result sbi_step_run_explicit(sb_body *body, sb_real dt, sb_step_info *info)
{
    sbi_step_guard guard = body->guard;
    for (int caution = guard.caution;; caution++) {
        sb_result result;
        sbi_step_loads(body);
        result = sbi_explicit_run(body, dt, caution, info);
        if (result == SB_OK) {
            sbi_explicit_calm(body, caution);
            return result;
        }
        sbi_step_undo(body);
        body->guard = guard;
        if (caution == SBI_EXPLICIT_CAUTION || (result != SB_ERROR_INVERTED && result != SB_ERROR_DIVERGED))
            return result;
    }
}

/* An implicit step. Generalised alpha extrapolates: if the material does not admit the end, it tries once more with the
 * balance at the end, where the line search watches. */
static sb_result sbi_step_run_implicit(const sbi_newton *start)
{
    sbi_newton newton = *start;
    sb_result result = sbi_step_run(&newton);
    if (result != SB_ERROR_INVERTED || newton.body->integrator != SB_GENERALISED_ALPHA || !(newton.level < 1))
        return result;
    sbi_step_undo(newton.body);
    newton = *start;
    newton.radius = 0;
    return sbi_step_run(&newton);
}

SB_API sb_result sb_body_step(sb_body *body, sb_real dt, sb_step_info *info)
{
    sb_step_info own;
    sbi_newton newton;
    sb_result result;
    double begin;
    int is_explicit;
    info = info ? info : &own;
    sbi_step_begin_info(info);
    if (!body || !(dt > 0) || !sb_is_finite(dt))
        return sbi_fail(&info->error, SB_ERROR_ARGUMENT, "a step needs a body and dt > 0, not %g", (double)dt);
    begin = sbi_step_now(body);
    memset(&newton, 0, sizeof newton);
    newton.body = body;
    newton.info = info;
    newton.dynamic = 1;
    newton.dt = dt;
    newton.load_factor = newton.level = newton.inertia_level = 1;
    newton.radius = body->spectral_radius;
    newton.max_newton = sbi_body_max_newton(body);
    is_explicit = body->integrator == SB_CENTRAL_DIFFERENCE;
    newton.linearised = newton.max_newton == 1 && !is_explicit;
    newton.max_iterations = body->max_iterations;
    newton.tolerance = sb_max(body->newton_tolerance, 64 * SB_EPSILON);
    newton.linear_tolerance = newton.linearised ? body->tolerance : 0;
    newton.line_search = !newton.linearised && !body->domain.single_rotation;
    sbi_step_watch_knots(body, newton.linearised);
    sbi_step_save(body);
    result = is_explicit ? sbi_step_run_explicit(body, dt, info) : sbi_step_run_implicit(&newton);
    if (result != SB_OK) {
        sbi_step_undo(body);
    } else {
        sbi_step_forget_error(info); /* of a tangent that was projected after all */
        info->load_steps = 1;
    }
    info->load_factor = result == SB_OK ? (sb_real)1 : (sb_real)0;
    info->seconds_total = sbi_step_now(body) - begin;
    return sbi_step_report(info, result);
}

/* ---- static solves ---- */

#define SBI_STATIC_COOKIE 0x57a71cu
enum { SBI_STATIC_NEWTON = 30 };

SB_API sb_static_options sb_default_static_options(void)
{
    sb_static_options options;
    memset(&options, 0, sizeof options);
    options.load_steps = 1;
    options.tolerance = (sb_real)1e-6;
    options.max_newton = SBI_STATIC_NEWTON;
    options.max_iterations = 20000;
    options.cookie = SBI_STATIC_COOKIE;
    return options;
}

static sb_result sbi_static_check(sb_body *body, const sb_static_options *options, sb_error *error)
{
    int node;
    if (!body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a static solve needs a body");
    if (options->cookie != SBI_STATIC_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the options were not made by sb_default_static_options");
    if (options->load_steps < 1 || options->max_newton < 1 || options->max_iterations < 1 ||
        !(options->tolerance > 0) || !(options->tolerance < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "load_steps, max_newton, max_iterations must be >= 1 and tolerance in (0, 1)");
    node = sbi_body_unsupported_node(body);
    if (node >= 0)
        return sbi_fail_node(error, SB_ERROR_UNCONSTRAINED, node,
                             "the part of the mesh with node %d can move freely: support it", node);
    return SB_OK;
}

/* external = equilibrated + factor (present loads - equilibrated); gravity pulls at int rho N dV. */
static void sbi_static_loads(sb_body *b, sb_real factor)
{
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 full = sb_v3_madd(b->dead_load[i], b->load_mass[i], b->gravity);
        b->external[i] = sb_v3_madd(b->equilibrated[i], factor, sb_v3_sub(full, b->equilibrated[i]));
    }
}

/* Raises the load factor to 1. An increment that fails goes back to the last converged one and is halved. */
static sb_result sbi_static_run(sbi_newton *newton, const sb_static_options *options)
{
    sb_body *b = newton->body;
    size_t bytes = (size_t)b->domain.node_count * sizeof(sb_vec3);
    sb_real reached = 0, stride = (sb_real)1 / (sb_real)options->load_steps, least = stride / 64;
    memcpy(b->converged, b->displacement, bytes);
    while (reached < 1) {
        int before = newton->info->newton_iterations, spent;
        sb_result result;
        newton->load_factor = sb_min((sb_real)1, reached + stride);
        if (newton->load_factor > 1 - (sb_real)1e-3 * stride)
            newton->load_factor = 1;
        newton->norm = newton->last_norm = 0;
        newton->energy_known = newton->cautious = 0;
        sbi_static_loads(b, newton->load_factor);
        result = sbi_newton_run(newton);
        spent = newton->info->newton_iterations - before;
        if (result != SB_OK) {
            memcpy(b->displacement, b->converged, bytes);
            b->force_current = 0;
            stride *= (sb_real)0.5;
            if (stride < least)
                return result;
            continue;
        }
        memcpy(b->converged, b->displacement, bytes);
        reached = newton->load_factor;
        newton->info->load_factor = reached;
        newton->info->load_steps++;
        if (spent <= 5)
            stride *= (sb_real)1.5;
        if (options->progress)
            options->progress(options->progress_user, newton->info);
    }
    return SB_OK;
}

/* Takes the last converged increment as the body's state: at rest, with exact reactions. */
static void sbi_static_commit(sbi_newton *newton)
{
    sb_body *b = newton->body;
    const sb_vec3 zero = sb_v3(0, 0, 0);
    size_t bytes = (size_t)b->domain.node_count * sizeof(sb_vec3);
    memset(b->velocity, 0, bytes);
    memset(b->acceleration, 0, bytes);
    sbi_static_loads(b, newton->info->load_factor);
    if (sbi_newton_force(newton) == SB_OK)
        for (int i = 0; i < b->domain.node_count; i++)
            b->reaction[i] = sbi_body_pick_axes(b->node_component[i] < 0 ? 0 : b->fixed[i],
                                           sb_v3_sub(b->internal[i], b->external[i]), zero);
    memcpy(b->equilibrated, b->external, bytes);
    sbi_body_update_positions(b);
    b->acceleration_known = 0;
}

SB_API sb_result sb_body_solve_static(sb_body *body, const sb_static_options *options, sb_step_info *info)
{
    sb_static_options defaults = sb_default_static_options();
    sb_step_info own;
    sbi_newton newton;
    sb_result result;
    double begin;
    info = info ? info : &own;
    options = options ? options : &defaults;
    sbi_step_begin_info(info);
    result = sbi_static_check(body, options, &info->error);
    if (result != SB_OK)
        return result;
    begin = sbi_step_now(body);
    memset(&newton, 0, sizeof newton);
    newton.body = body;
    newton.info = info;
    newton.tolerance = sb_max(options->tolerance, 64 * SB_EPSILON);
    newton.max_newton = sbi_max_int(options->max_newton, 2);
    if (body->domain.single_rotation) /* its tangent leaves dR/dx out, so that it converges linearly */
        newton.max_newton = sbi_max_int(newton.max_newton, 10 * SBI_STATIC_NEWTON);
    newton.max_iterations = options->max_iterations;
    newton.line_search = !body->domain.single_rotation;
    sbi_step_watch_knots(body, 0);
    sbi_step_save(body);
    result = sbi_static_run(&newton, options);
    if (result == SB_OK || (options->keep_progress && info->load_steps > 0)) {
        sb_error error = info->error;
        sbi_static_commit(&newton);
        info->error = error;
    } else {
        sbi_step_undo(body);
    }
    if (result == SB_OK)
        sbi_step_forget_error(info); /* of attempts with longer increments */
    info->seconds_total = sbi_step_now(body) - begin;
    return sbi_step_report(info, result);
}

/* ==== src/softbody/modes.c ==== */
/* modes: block Davidson on A x = mu M x, A = K + shift M, mu = lambda + shift.
 *
 * The basis V is orthonormal in M; H = V^T A V is kept in double. Vectors are 0 on supported axes, where A has rows of
 * its own. All solves are rough: they only have to point the right way, since Ritz values and residuals are made from
 * A and M themselves. Random vectors at the start, as many as modes are wanted, and a second handful before the end
 * see to it that no copy of a multiple frequency is missed. */

#include <math.h>
#include <string.h>


#define SBI_MODES_COOKIE 0x3d0deu
enum {
    SBI_MODES_GUARD = 4,   /* Ritz vectors beyond the wanted ones that are improved along with them */
    SBI_MODES_BLOCK = 12,  /* most vectors by which the space grows at a time */
    SBI_MODES_PROBES = 4   /* random vectors of the last look */
};

typedef struct sbi_modes {
    sb_body *body;
    const sb_modes_options *options;
    sb_modes_info *info;
    sb_error *error;
    sb_preconditioner *precond;
    int nodes, count;
    int freedom;              /* degrees of freedom */
    int capacity, size;       /* of the basis */
    int block;                /* residuals per round */
    double shift;             /* 1/s^2 */
    double rounding;          /* of a residual (1/s^2) */
    uint64_t random;
    sb_real *mass;            /* [block_count] (kg) */
    sb_vec3 *basis;           /* [capacity][nodes] */
    sb_vec3 *fresh;           /* [block][nodes] directions to grow by */
    sb_vec3 *x, *ax, *mx;     /* [nodes] */
    double *projected;        /* [capacity][capacity] H */
    double *vectors;          /* [capacity][capacity] row i: eigenvector i of H */
    double *values;           /* [capacity] ascending */
    double *scratch;          /* [3 capacity] */
    void *memory;
} sbi_modes;

SB_API sb_modes_options sb_default_modes_options(void)
{
    sb_modes_options options;
    memset(&options, 0, sizeof options);
    options.mass = SB_MASS_CONSISTENT;
    options.tolerance = (sb_real)1e-8;
    options.max_iterations = 100;
    options.cookie = SBI_MODES_COOKIE;
    return options;
}

/* ---- small symmetric eigenproblem: Householder, then QL with implicit shifts (Wilkinson and Reinsch 1971) ---- */

/* Reduces a[n][n] to the diagonal d and the neighbours e[0 .. n-2], reflections on the way left below the diagonal;
 * scale[k] is 2/v.v of reflection k. */
static void sbi_modes_tridiagonalise(double *a, int n, double *d, double *e, double *scale)
{
    for (int k = 0; k < n - 1; k++) {
        double norm = 0, along = 0, *w = d; /* d is free below */
        for (int i = k + 1; i < n; i++)
            norm += a[i * n + k] * a[i * n + k];
        norm = sqrt(norm);
        scale[k] = 0;
        e[k] = a[(k + 1) * n + k];
        if (k == n - 2 || !(norm > 0))
            continue;
        e[k] = e[k] > 0 ? -norm : norm;
        a[(k + 1) * n + k] -= e[k];
        scale[k] = 1 / (-e[k] * a[(k + 1) * n + k]);
        for (int i = k + 1; i < n; i++) {
            double sum = 0;
            for (int j = k + 1; j < n; j++)
                sum += (j <= i ? a[i * n + j] : a[j * n + i]) * a[j * n + k];
            w[i] = scale[k] * sum;
            along += w[i] * a[i * n + k];
        }
        for (int i = k + 1; i < n; i++)
            w[i] -= 0.5 * scale[k] * along * a[i * n + k];
        for (int i = k + 1; i < n; i++)
            for (int j = k + 1; j <= i; j++)
                a[i * n + j] -= a[i * n + k] * w[j] + w[i] * a[j * n + k];
    }
    for (int i = 0; i < n; i++)
        d[i] = a[i * n + i];
}

/* Row j of z: the reflections applied to unit vector j. */
static void sbi_modes_accumulate(const double *a, int n, const double *scale, double *z)
{
    memset(z, 0, (size_t)n * (size_t)n * sizeof *z);
    for (int j = 0; j < n; j++) {
        double *row = z + (size_t)j * (size_t)n;
        row[j] = 1;
        for (int k = n - 3; k >= 0; k--) {
            double sum = 0;
            for (int i = k + 1; i < n; i++)
                sum += a[i * n + k] * row[i];
            for (int i = k + 1; i < n; i++)
                row[i] -= scale[k] * sum * a[i * n + k];
        }
    }
}

/* One sweep on the unreduced part l .. m of the tridiagonal matrix; turns the rows of z along. */
static void sbi_modes_ql_sweep(double *d, double *e, int l, int m, double *z, int n)
{
    double g = (d[l + 1] - d[l]) / (2 * e[l]), r = sqrt(g * g + 1), s = 1, c = 1, p = 0;
    g = d[m] - d[l] + e[l] / (g + (g < 0 ? -r : r));
    for (int i = m - 1; i >= l; i--) {
        double f = s * e[i], b = c * e[i], *low = z + (size_t)i * (size_t)n, *high = low + n;
        r = sqrt(f * f + g * g);
        e[i + 1] = r;
        if (!(r > 0)) { /* the matrix falls apart here: the next sweep finds that */
            d[i + 1] -= p;
            e[m] = 0;
            return;
        }
        s = f / r;
        c = g / r;
        g = d[i + 1] - p;
        r = (d[i] - g) * s + 2 * c * b;
        p = s * r;
        d[i + 1] = g + p;
        g = c * r - b;
        for (int k = 0; k < n; k++) {
            f = high[k];
            high[k] = s * low[k] + c * f;
            low[k] = c * low[k] - s * f;
        }
    }
    d[l] -= p;
    e[l] = g;
    e[m] = 0;
}

/* Eigenvalues d ascending and eigenvectors, the rows of z, of the symmetric a[n][n], which is overwritten; its lower
 * triangle is read. scratch: [2 n]. Returns 0 when an entry is not finite. */
static int sbi_modes_eigen(double *a, int n, double *d, double *z, double *scratch)
{
    double *e = scratch, *scale = scratch + n;
    sbi_modes_tridiagonalise(a, n, d, e, scale);
    sbi_modes_accumulate(a, n, scale, z);
    e[n - 1] = 0;
    for (int l = 0, sweeps = 0; l < n;) {
        int m = l;
        while (m < n - 1 && !(fabs(e[m]) <= 2.2e-16 * (fabs(d[m]) + fabs(d[m + 1]))))
            m++;
        if (m == l) {
            l++;
            sweeps = 0;
            continue;
        }
        if (++sweeps > 60) /* two are usual; NaN never ends */
            return 0;
        sbi_modes_ql_sweep(d, e, l, m, z, n);
    }
    for (int i = 0; i < n; i++) { /* few are out of order: insertion */
        int least = i;
        for (int j = i + 1; j < n; j++)
            if (d[j] < d[least])
                least = j;
        if (least != i) {
            double value = d[i];
            d[i] = d[least];
            d[least] = value;
            for (int k = 0; k < n; k++) {
                value = z[(size_t)i * (size_t)n + (size_t)k];
                z[(size_t)i * (size_t)n + (size_t)k] = z[(size_t)least * (size_t)n + (size_t)k];
                z[(size_t)least * (size_t)n + (size_t)k] = value;
            }
        }
    }
    return 1;
}

/* ---- vectors ---- */

static sb_vec3 *sbi_modes_basis(const sbi_modes *m, int i) { return m->basis + (size_t)i * (size_t)m->nodes; }

static double sbi_modes_dot(const sbi_modes *m, const sb_vec3 *a, const sb_vec3 *b)
{
    double sum = 0;
    for (int i = 0; i < m->nodes; i++)
        sum += (double)a[i].x * (double)b[i].x + (double)a[i].y * (double)b[i].y + (double)a[i].z * (double)b[i].z;
    return sum;
}

/* a += s b */
static void sbi_modes_add(const sbi_modes *m, sb_vec3 *a, double s, const sb_vec3 *b)
{
    for (int i = 0; i < m->nodes; i++)
        a[i] = sb_v3_madd(a[i], (sb_real)s, b[i]);
}

static void sbi_modes_mask(const sbi_modes *m, sb_vec3 *a)
{
    for (int i = 0; i < m->nodes; i++)
        a[i] = sbi_body_pick_axes(m->body->fixed[i], sb_v3(0, 0, 0), a[i]);
}

/* out = M x on free axes */
static void sbi_modes_mass_times(const sbi_modes *m, const sb_vec3 *x, sb_vec3 *out)
{
    const sb_matrix *matrix = &m->body->matrix;
    for (int i = 0; i < m->nodes; i++) {
        sb_vec3 sum = sb_v3(0, 0, 0);
        for (int k = matrix->row_start[i]; k < matrix->row_start[i + 1]; k++)
            sum = sb_v3_madd(sum, m->mass[k], x[matrix->columns[k]]);
        out[i] = sbi_body_pick_axes(m->body->fixed[i], sb_v3(0, 0, 0), sum);
    }
}

static void sbi_modes_stiffness_times(const sbi_modes *m, const sb_vec3 *x, sb_vec3 *out)
{
    sb_matrix_multiply(&m->body->matrix, &x[0].x, &out[0].x, &m->body->jobs);
}

/* Number in (-1, 1) (xorshift64*). */
static sb_real sbi_modes_random(sbi_modes *m)
{
    m->random ^= m->random >> 12;
    m->random ^= m->random << 25;
    m->random ^= m->random >> 27;
    return (sb_real)((double)((m->random * 2685821657736338717ULL) >> 12) / 2251799813685248.0 - 1);
}

static void sbi_modes_fill_random(sbi_modes *m, sb_vec3 *a)
{
    for (int i = 0; i < m->nodes; i++) {
        a[i].x = sbi_modes_random(m);
        a[i].y = sbi_modes_random(m);
        a[i].z = sbi_modes_random(m);
    }
    sbi_modes_mask(m, a);
}

/* out = A^-1 rhs, roughly; rhs is 0 on supported axes. */
static sb_result sbi_modes_solve(sbi_modes *m, const sb_vec3 *rhs, sb_vec3 *out, double tolerance)
{
    sb_body *b = m->body;
    sb_pcg_options options = sb_default_pcg_options();
    sb_pcg_info pcg = {0, 0, 0, 0, 0};
    sb_result result;
    options.tolerance = tolerance;
    options.max_iterations = 500;
    options.jobs = &b->jobs;
    memset(out, 0, (size_t)m->nodes * sizeof *out);
    result = sb_pcg_solve(&b->matrix, m->precond, &rhs[0].x, &out[0].x, &options, &b->pcg, &pcg);
    m->info->solves++;
    m->info->pcg_iterations += pcg.iterations;
    if (result == SB_ERROR_INDEFINITE && pcg.negative_curvature)
        return sbi_fail(m->error, result, "the stiffness is not positive definite: the shape is not stable");
    if (result == SB_ERROR_DIVERGED)
        return sbi_fail(m->error, result, "a linear solve met numbers that are not finite");
    sbi_modes_mask(m, out);
    return SB_OK;
}

/* ---- the space ---- */

/* Makes t orthonormal to the basis in M (Gram-Schmidt, twice), puts it in and extends H. A t that adds nothing but
 * rounding is left out. */
static void sbi_modes_append(sbi_modes *m, sb_vec3 *t)
{
    double *h = m->projected, before, norm;
    sb_vec3 *place;
    if (m->size == m->capacity)
        return;
    sbi_modes_mass_times(m, t, m->mx);
    before = norm = sbi_modes_dot(m, t, m->mx);
    for (int pass = 0; pass < 2; pass++) {
        for (int j = 0; j < m->size; j++)
            m->scratch[j] = sbi_modes_dot(m, sbi_modes_basis(m, j), m->mx);
        for (int j = 0; j < m->size; j++)
            sbi_modes_add(m, t, -m->scratch[j], sbi_modes_basis(m, j));
        sbi_modes_mass_times(m, t, m->mx);
        norm = sbi_modes_dot(m, t, m->mx);
        if (!(norm > 1e4 * (double)SB_EPSILON * (double)SB_EPSILON * before))
            return;
        norm = 1 / sqrt(norm);
        for (int i = 0; i < m->nodes; i++) {
            t[i] = sb_v3_scale((sb_real)norm, t[i]);
            m->mx[i] = sb_v3_scale((sb_real)norm, m->mx[i]);
        }
        before = 1;
    }
    place = sbi_modes_basis(m, m->size);
    memcpy(place, t, (size_t)m->nodes * sizeof *t);
    sbi_modes_stiffness_times(m, place, m->ax);
    for (int j = 0; j <= m->size; j++)
        h[(size_t)m->size * (size_t)m->capacity + (size_t)j] = h[(size_t)j * (size_t)m->capacity + (size_t)m->size] =
            sbi_modes_dot(m, sbi_modes_basis(m, j), m->ax);
    m->size++;
}

/* Adds `count` random vectors with their fast motions taken out; first what the basis has already, lest nearly rigid
 * motions drown the rest. In the smallest of problems nothing else is left: then the random vector itself. */
static sb_result sbi_modes_append_random(sbi_modes *m, int count)
{
    sb_result result = SB_OK;
    for (int k = 0; k < count && result == SB_OK; k++) {
        int before = m->size;
        sbi_modes_fill_random(m, m->x);
        sbi_modes_mass_times(m, m->x, m->ax);
        for (int j = 0; j < m->size; j++)
            m->scratch[j] = sbi_modes_dot(m, sbi_modes_basis(m, j), m->ax);
        for (int j = 0; j < m->size; j++)
            sbi_modes_add(m, m->x, -m->scratch[j], sbi_modes_basis(m, j));
        sbi_modes_mass_times(m, m->x, m->ax);
        result = sbi_modes_solve(m, m->ax, m->fresh, 0.1);
        if (result == SB_OK)
            sbi_modes_append(m, m->fresh);
        if (result == SB_OK && m->size == before)
            sbi_modes_append(m, m->x);
    }
    return result;
}

/* The rigid motions of all parts together, which supports may leave: six good vectors to begin with. */
static void sbi_modes_append_rigid(sbi_modes *m)
{
    for (int k = 0; k < 6; k++) {
        for (int i = 0; i < m->nodes; i++) {
            sb_vec3 x = sb_v3_sub(m->body->reference[i], m->body->reference[0]);
            if (m->options->at_present)
                x = sb_v3_sub(m->body->position[i], m->body->position[0]);
            sb_vec3 axis = sb_v3(k % 3 == 0, k % 3 == 1, k % 3 == 2);
            m->x[i] = k < 3 ? axis : sb_v3_cross(axis, x);
        }
        sbi_modes_mask(m, m->x);
        sbi_modes_append(m, m->x);
    }
}

/* Ritz values and vectors of the basis. */
static sb_result sbi_modes_project(sbi_modes *m)
{
    int n = m->size;
    double *a = m->vectors + (size_t)m->capacity * (size_t)m->capacity;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++)
            a[i * n + j] = m->projected[(size_t)i * (size_t)m->capacity + (size_t)j];
    if (!sbi_modes_eigen(a, n, m->values, m->vectors, m->scratch))
        return sbi_fail(m->error, SB_ERROR_DIVERGED, "the projected stiffness is not finite");
    return SB_OK;
}

/* x = Ritz vector i */
static void sbi_modes_ritz(sbi_modes *m, int i, sb_vec3 *x)
{
    memset(x, 0, (size_t)m->nodes * sizeof *x);
    for (int j = 0; j < m->size; j++)
        sbi_modes_add(m, x, m->vectors[(size_t)i * (size_t)m->size + (size_t)j], sbi_modes_basis(m, j));
}

/* ax = A x - mu M x of Ritz vector i; returns its norm in (lumped M)^-1 over lambda, 0 when it is rounding. */
static double sbi_modes_residual(sbi_modes *m, int i)
{
    double square = 0, lambda = m->values[i] - m->shift, norm;
    sbi_modes_ritz(m, i, m->x);
    sbi_modes_stiffness_times(m, m->x, m->ax);
    sbi_modes_mass_times(m, m->x, m->mx);
    sbi_modes_add(m, m->ax, -m->values[i], m->mx);
    sbi_modes_mask(m, m->ax);
    for (int k = 0; k < m->nodes; k++)
        if (m->body->lumped_mass[k] > 0)
            square += (double)sb_v3_dot(m->ax[k], m->ax[k]) / (double)m->body->lumped_mass[k];
    norm = sqrt(square);
    if (norm <= m->rounding)
        return 0;
    return norm / (lambda > m->shift ? lambda : m->shift > 0 ? m->shift : fabs(lambda));
}

/* Keeps the lowest Ritz vectors as the basis. */
static void sbi_modes_restart(sbi_modes *m, int keep)
{
    sb_real *row = (sb_real *)(void *)m->scratch;
    for (int i = 0; i < m->nodes; i++)
        for (int axis = 0; axis < 3; axis++) {
            for (int k = 0; k < keep; k++) {
                double sum = 0;
                for (int j = 0; j < m->size; j++)
                    sum += m->vectors[(size_t)k * (size_t)m->size + (size_t)j] *
                           (double)(&sbi_modes_basis(m, j)[i].x)[axis];
                row[k] = (sb_real)sum;
            }
            for (int k = 0; k < keep; k++)
                (&sbi_modes_basis(m, k)[i].x)[axis] = row[k];
        }
    for (int i = 0; i < keep; i++)
        for (int j = 0; j < keep; j++)
            m->projected[(size_t)i * (size_t)m->capacity + (size_t)j] = i == j ? m->values[i] : 0;
    m->size = keep;
}

/* Collects directions that improve the lowest vectors not yet good enough; returns how many of the wanted ones are
 * not, and in *grown how many directions there are. */
static sb_result sbi_modes_improve(sbi_modes *m, int *missing, int *grown)
{
    int tried = sbi_min_int(m->count + SBI_MODES_GUARD, m->size);
    sb_result result = SB_OK;
    double worst = 0;
    *missing = *grown = 0;
    for (int i = 0; i < tried && *grown < m->block && result == SB_OK; i++) {
        double residual = sbi_modes_residual(m, i);
        if (i < m->count)
            worst = residual > worst ? residual : worst;
        if (residual <= (double)m->options->tolerance)
            continue;
        if (i < m->count && !(*missing)++)
            sbi_fail(m->error, SB_ERROR_NOT_CONVERGED, "mode %d has a residual of %g after %d iterations", i + 1,
                     residual, m->info->iterations);
        if (i < m->count || *missing) {
            result = sbi_modes_solve(m, m->ax, m->fresh + (size_t)*grown * (size_t)m->nodes, 0.01);
            ++*grown;
        }
    }
    m->info->residual = (sb_real)worst;
    return result;
}

/* Rounds of projection and growth until every wanted mode is good enough, also after a last look for missed ones. */
static sb_result sbi_modes_iterate(sbi_modes *m)
{
    int checked = 0;
    for (;;) {
        int missing, grown, keep;
        sb_result result = sbi_modes_project(m);
        if (result == SB_OK && m->size < m->count)
            result = sbi_fail(m->error, SB_ERROR_NOT_CONVERGED, "mode %d does not show in %d vectors", m->size + 1,
                              m->size);
        if (result == SB_OK)
            result = sbi_modes_improve(m, &missing, &grown);
        if (result != SB_OK)
            return result;
        if (missing == 0 && (checked || m->size >= m->freedom))
            return SB_OK;
        if (m->size >= m->freedom) /* the space is everything: what is left is rounding */
            return SB_OK;
        if (m->info->iterations == m->options->max_iterations)
            return SB_ERROR_NOT_CONVERGED;
        m->info->iterations++;
        keep = sbi_min_int(m->count + SBI_MODES_GUARD + SBI_MODES_BLOCK, m->size);
        if (m->size + grown + SBI_MODES_PROBES > m->capacity && m->capacity < m->freedom)
            sbi_modes_restart(m, keep);
        for (int k = 0; k < grown; k++)
            sbi_modes_append(m, m->fresh + (size_t)k * (size_t)m->nodes);
        if (missing == 0) {
            checked = 1;
            result = sbi_modes_append_random(m, SBI_MODES_PROBES);
            if (result != SB_OK)
                return result;
        }
    }
}

/* ---- set-up ---- */

static int sbi_modes_count_freedom(const sb_body *b)
{
    int free_axes = 0;
    for (int i = 0; i < b->domain.node_count; i++)
        free_axes += 3 - (b->fixed[i] & 1) - (b->fixed[i] >> 1 & 1) - (b->fixed[i] >> 2 & 1);
    return free_axes;
}

static sb_result sbi_modes_check(const sb_body *body, int count, const sb_modes_options *options,
                                 const sb_real *frequencies, sb_error *error)
{
    if (!body || !frequencies)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_modes needs a body and a place for frequencies");
    if (options->cookie != SBI_MODES_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the options were not made by sb_default_modes_options");
    if (options->mass != SB_MASS_LUMPED && options->mass != SB_MASS_CONSISTENT && options->mass != SB_MASS_REDUCED)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "options.mass %d is unknown", (int)options->mass);
    if (!(options->tolerance > 0) || !(options->tolerance < 1) || options->max_iterations < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "options.tolerance %g must be in (0, 1), max_iterations %d >= 1",
                        (double)options->tolerance, options->max_iterations);
    if (count < 1 || count > sbi_modes_count_freedom(body))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d modes of a body with %d free degrees of freedom", count,
                        sbi_modes_count_freedom(body));
    return SB_OK;
}

static void sbi_modes_layout(sbi_modes *m, sbi_arena *arena)
{
    size_t vector = (size_t)m->nodes * sizeof(sb_vec3), c = (size_t)m->capacity;
    m->mass = (sb_real *)sbi_arena_take(arena, (size_t)m->body->matrix.block_count, sizeof(sb_real));
    m->basis = (sb_vec3 *)sbi_arena_take(arena, c, vector);
    m->fresh = (sb_vec3 *)sbi_arena_take(arena, (size_t)m->block, vector);
    m->x = (sb_vec3 *)sbi_arena_take(arena, 1, vector);
    m->ax = (sb_vec3 *)sbi_arena_take(arena, 1, vector);
    m->mx = (sb_vec3 *)sbi_arena_take(arena, 1, vector);
    m->projected = (double *)sbi_arena_take(arena, c, c * sizeof(double));
    m->vectors = (double *)sbi_arena_take(arena, 2 * c, c * sizeof(double)); /* and what the eigensolver overwrites */
    m->values = (double *)sbi_arena_take(arena, c, sizeof(double));
    m->scratch = (double *)sbi_arena_take(arena, c, 3 * sizeof(double));
}

static sb_result sbi_modes_take_memory(sbi_modes *m)
{
    sbi_arena arena = {NULL, 0, 0};
    unsigned char *base;
    sbi_modes_layout(m, &arena);
    if (!arena.overflow && arena.used <= (size_t)-1 - 64)
        m->memory = sbi_alloc(&m->body->allocator, arena.used + 64, 1);
    if (!m->memory)
        return sbi_fail(m->error, SB_ERROR_MEMORY, "no memory for %d vectors of %d nodes", m->capacity, m->nodes);
    base = (unsigned char *)m->memory;
    arena.base = base + (64 - (size_t)((uintptr_t)base & 63));
    arena.used = 0;
    sbi_modes_layout(m, &arena);
    return SB_OK;
}

/* matrix = K of the shape that is asked for. The warm starts of rotations are put back by the caller. */
static sb_result sbi_modes_assemble(sbi_modes *m)
{
    sb_body *b = m->body;
    sbi_assembly *assembly = &b->assembly;
    size_t points = (size_t)b->domain.cell_count * (size_t)b->domain.points_per_cell;
    const sb_vec3 *u = b->displacement;
    int bad = -1;
    if (!m->options->at_present) {
        memset(m->x, 0, (size_t)m->nodes * sizeof *m->x);
        u = m->x;
        for (size_t i = 0; i < points && !assembly->batched; i++)
            assembly->rotations[i] = sb_quat_identity();
    } else if (!b->force_current) {
        bad = sbi_assembly_force(assembly, u, m->mx);
    }
    if (bad < 0)
        bad = sbi_assembly_tangent(assembly, u, SB_TANGENT_EXACT, 1, &b->matrix);
    if (bad >= 0)
        return sbi_fail_element(m->error, SB_ERROR_INVERTED, bad,
                                "element %d is inside out, which its material does not allow", bad);
    return SB_OK;
}

/* Speed of shear waves over the size of the body, squared (1/s^2): slender bodies have lower frequencies, none much
 * lower than a share of it. */
static double sbi_modes_unit(const sb_body *b)
{
    double stiffness = 0, mass = 0, size = 0;
    for (int e = 0; e < b->domain.cell_count; e++) {
        const sb_material *material = b->materials + b->cell_material[e];
        for (int p = 0; p < b->domain.points_per_cell; p++) {
            double w = (double)b->domain.weights[(size_t)e * (size_t)b->domain.points_per_cell + (size_t)p];
            stiffness += w * (double)material->mu;
            mass += w * (double)material->density;
        }
    }
    for (int c = 0; c < b->component_count; c++) {
        double s = (double)sb_v3_norm(sb_v3_sub(b->component_high[c], b->component_low[c]));
        size = s > size ? s : size;
    }
    return stiffness / (mass * size * size);
}

/* A = K + shift M with supports, and its preconditioner. Supported bodies need no shift. */
static sb_result sbi_modes_prepare(sbi_modes *m)
{
    sb_body *b = m->body;
    sb_preconditioner_def settings = sb_default_preconditioner_def();
    sb_matrix *matrix = &b->matrix;
    double step;
    sb_result result = sbi_modes_assemble(m);
    if (result != SB_OK)
        return result;
    sbi_body_mass_blocks(b, m->options->mass, m->mass);
    step = (double)sbi_explicit_bound(b);
    m->rounding = 4 * (double)SB_EPSILON * 4 / (step * step);
    if (sbi_body_unsupported_node(b) >= 0) {
        m->shift = 1e-4 * sbi_modes_unit(b);
        m->shift = m->shift > 16 * m->rounding ? m->shift : 16 * m->rounding;
    }
    for (int k = 0; k < matrix->block_count; k++)
        for (int axis = 0; axis < 3; axis++)
            matrix->blocks[k][4 * axis] += (sb_real)m->shift * m->mass[k];
    sb_matrix_constrain(matrix, b->fixed, NULL, NULL);
    settings.positions = m->options->at_present ? b->position : b->reference;
    result = sb_preconditioner_create(&settings, matrix, &b->allocator, &m->precond, m->error);
    if (result == SB_OK)
        result = sb_preconditioner_update(m->precond, matrix, NULL, m->error);
    return result;
}

static void sbi_modes_write(sbi_modes *m, sb_real *frequencies, sb_vec3 *shapes)
{
    for (int i = 0; i < m->count; i++) {
        double lambda = m->values[i] - m->shift;
        frequencies[i] = (sb_real)(sqrt(lambda > 0 ? lambda : 0) / 6.283185307179586);
        if (shapes)
            sbi_modes_ritz(m, i, shapes + (size_t)i * (size_t)m->nodes);
    }
}

static sb_result sbi_modes_run(sbi_modes *m, sb_real *frequencies, sb_vec3 *shapes)
{
    sb_result result = sbi_modes_take_memory(m);
    if (result == SB_OK)
        result = sbi_modes_prepare(m);
    if (result == SB_OK && m->shift > 0)
        sbi_modes_append_rigid(m);
    if (result == SB_OK)
        result = sbi_modes_append_random(m, sbi_min_int(m->count + SBI_MODES_GUARD, m->freedom));
    if (result == SB_OK)
        result = sbi_modes_iterate(m);
    if (result == SB_OK)
        sbi_modes_write(m, frequencies, shapes);
    return result;
}

SB_API sb_result sb_body_modes(sb_body *body, int count, const sb_modes_options *options, sb_real *frequencies,
                               sb_vec3 *shapes, sb_modes_info *info, sb_error *error)
{
    sb_modes_options defaults = sb_default_modes_options();
    sb_modes_info report;
    sb_error own;
    sbi_modes m;
    double begin;
    sb_result result;
    options = options ? options : &defaults;
    result = sbi_modes_check(body, count, options, frequencies, error);
    if (result != SB_OK)
        return result;
    begin = body->clock ? body->clock() : 0;
    memset(&report, 0, sizeof report);
    memset(&m, 0, sizeof m);
    m.body = body;
    m.options = options;
    m.info = &report;
    m.error = &own;
    m.nodes = body->domain.node_count;
    m.count = count;
    m.freedom = sbi_modes_count_freedom(body);
    m.block = SBI_MODES_BLOCK;
    m.capacity = count > m.freedom / 3 ? m.freedom : sbi_min_int(m.freedom, count + count / 2 + 8 + 3 * m.block);
    m.random = 88172645463325252ULL;
    sbi_assembly_save_rotations(&body->assembly);
    result = sbi_modes_run(&m, frequencies, shapes);
    sbi_assembly_restore_rotations(&body->assembly);
    sb_preconditioner_free(m.precond);
    sbi_free(&body->allocator, m.memory);
    report.seconds = body->clock ? body->clock() - begin : 0;
    if (info && (result == SB_OK || result == SB_ERROR_NOT_CONVERGED))
        *info = report;
    if (error && result != SB_OK)
        *error = own;
    return result;
}

#endif /* SB_IMPLEMENTATION */

/* ==== src/softbody/end.h ==== */
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
