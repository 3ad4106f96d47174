/* needle.h 0.5.0: flexible needles in soft tissue
 * MIT or public domain, as you like; the texts are at the end of this file.
 * Generated from src/needle/: edit there, then run `make headers`. */
#include "softbody.h"

/* ==== src/needle/needle_doc.h ==== */
/*
 * needle.h - flexible needles in soft tissue, in one header on top of softbody.h.
 *
 * HOW TO INCLUDE
 *
 * In one C or C++ file, which is the one that holds softbody.h's implementation:
 *
 *     #define SB_IMPLEMENTATION
 *     #define NDL_IMPLEMENTATION
 *     #include "needle.h"
 *
 * and in all others only the last line; it includes softbody.h. Both headers come from one release and lie in one
 * folder. Link with -lm, optimise (-O2 or -O3).
 *
 * OPTIONS are softbody.h's. SB_REAL: exported names of a float build end in _f32. SB_STATIC, SB_SHARED and
 * SB_API hold for this header, too; NDL_STATIC or NDL_API for this one only.
 *
 * WHAT IT DOES NOT DO
 *
 * Shafts do not touch the tissue's skin from outside, needles do not touch each other, and a tip that reaches the far
 * side of the tissue is stopped there, but for where that was burnt away.
 *
 * With NDL_REMESH needles go into bodies of SB_TET4 only
 * (SB_ERROR_UNSUPPORTED otherwise); all bodies with needles take implicit steps. What is embedded in a body follows the
 * changes that needles make where it is asked to (sb_embedding_follow).
 *
 * A FIRST PROGRAM
 *
 * A bevelled nitinol needle is pushed 4 cm into a block of gel, turned by half a turn on its way, and drawn out again;
 * the force that a hand feels is printed:
 *
 *     ```c
 *     #define SB_IMPLEMENTATION
 *     #define NDL_IMPLEMENTATION
 *     #include "needle.h"
 *     #include <math.h>
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
 *         sb_mesh mesh;                                                 // a block of 6 x 6 x 6 cm, corner at 0
 *         require(sb_mesh_beam(SB_TET4, 10, 10, 10, sb_v3(0.06, 0.06, 0.06), NULL, &mesh, &error), &error);
 *
 *         sb_body_def bd = sb_default_body_def();
 *         bd.mesh = &mesh;
 *         bd.material = sb_material_corotated(50e3, 0.45, 1000);        // Young's modulus, Poisson's ratio, density
 *         sb_body *body = NULL;
 *         require(sb_body_create(&bd, &body, &error), &error);
 *         for (int i = 0; i < mesh.node_count; i++)
 *             if (mesh.nodes[i].z < 1e-6)                               // it stands on a table
 *                 require(sb_body_hold(body, &i, 1, SB_XYZ, &error), &error);
 *
 *         ndl_friction friction = {20, 0, 0.5, 0, 0};                   // 20 N/m along the shaft, 0.5 N to cut
 *         ndl_needle_def nd = ndl_default_needle_def();
 *         nd.body = body;
 *         nd.base = sb_v3(0.031, 0.029, 0.12), nd.direction = sb_v3(0, 0, -1); // 6 cm above, looking down
 *         nd.length = 0.058;                                            // tip 2 mm above the skin
 *         nd.frictions = &friction, nd.friction_count = 1;
 *         nd.bevel.curvature = 8;                                       // bends with a radius of 12.5 cm
 *         ndl_rod_section_preset(NDL_NITINOL_083, &nd.section);
 *         ndl_needle *needle = NULL;
 *         require(ndl_needle_create(&nd, &needle, &error), &error);
 *
 *         sb_vec3 force;
 *         for (int frame = 0; frame < 280; frame++) {                   // 50 per second
 *             ndl_command command = {0};
 *             ndl_step_info info;
 *             command.insertion = frame < 180 ? 0.0125 : -0.025;        // m/s
 *             command.twist = frame >= 90 && frame < 100 ? 3.14159265 / 0.2 : 0; // rad/s
 *             require(ndl_step(body, &needle, 1, 0.02, &command, &info, &error), &error);
 *             ndl_needle_base_wrench(needle, &force, NULL);             // what the hand exerts
 *             if (frame % 40 == 0) {
 *                 sb_vec3 tip = ndl_needle_tip(needle).position;
 *                 printf("tip %.1f %.1f %.1f mm, depth %.1f mm, hand %.2f N\n", 1e3 * tip.x, 1e3 * tip.y, 1e3 * tip.z,
 *                        1e3 * ndl_needle_depth(needle), -force.z);
 *             }
 *         }
 *         int out = !(ndl_needle_depth(needle) > 0);
 *         printf("the needle is %s\n", out ? "out again" : "in");
 *         ndl_needle_destroy(needle);                                   // before its body
 *         sb_body_destroy(body);
 *         sb_mesh_free(&mesh);
 *         return out ? 0 : 1;
 *     }
 *     ```
 *
 * CONCEPTS
 *
 * Units are SI. Results, errors, memory, threads and determinism are as softbody.h says in its top comment.
 *
 * body         what needles go into: an sb_body of any elements and material (tet4 with def.slack where the mesh is to
 *              follow), with Prony terms, fibres, regions, supports, loads and constraints, cut or not; sb_body_step
 *              moves it without its needles.
 * ndl_needle   a needle at one body, which it enters from outside: a sleeve that feeds and turns it, a rod, a tip that
 *              cuts. ndl_step moves a body and all its needles together: the linear systems of the body's own step,
 *              solved again with other states of friction where a node sticks that should slip, or the other way.
 * follow       how a needle is held. NDL_EMBED, the default: springs hold it at material points, and the mesh stays as
 *              it is: forces that do not depend on the mesh, any elements, bodies that are cut, needles side by side.
 *              NDL_REMESH: each of its nodes in tissue lies on a node of the mesh, which follows.
 * contact      along the needle each node sticks or slips (ndl_contact). Friction is a force per length of shaft by
 *              region, cutting a force at the tip; membranes are faces between regions that take more force to
 *              puncture. What a hand feels: ndl_needle_base_wrench.
 * bevel        puts the tip's cut aside, so that the needle bends: by a curvature (ndl_bevel, circles of that
 *              curvature in tissue that does not give way; softer tissue gives less) or by an angle, as in the thesis.
 *              The side turns with the base, later where tissue holds the shaft (twist_stiffness, twist_friction).
 * remeshing    with NDL_REMESH the mesh follows the tip by moving nodes and splitting tets, and is as it was when the
 *              needle is out. Inside ndl_step; ndl_remesh is there for other uses of the same.
 * steering     ndl_plan finds a helix to a target past obstacles, ndl_steer follows it step by step from sensed tips,
 *              ndl_push moves tissue so that a target comes onto a straight needle's way. They need poses only.
 * ndl_rod      the elastic rod by itself: a chain of nodes, base first, that stretches, bends and twists; straight or
 *              pre-bent at rest. Supports (ndl_rod_hold, _turn, _hold_base) and loads stay until changed;
 *              ndl_rod_step moves it, ndl_rod_solve_static finds its equilibrium.
 * frames       each edge of a rod has a material frame (m1, m2, t), t along it. A bevel bends towards m2 of the last.
 * state        sb_body_state_save holds needles, too: loaded in mid-insertion they go on to the last bit.
 *
 * A step that fails leaves everything as it was. All memory for stepping is taken at creation; only a mesh that grows
 * beyond its slack asks for more.
 *
 * LICENCE
 *
 * MIT or public domain, as you like; the texts are at the end of this file.
 */

/* ==== src/needle/../softbody/begin.h ==== */
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

#ifndef NEEDLE_H
#define NEEDLE_H

/* ==== src/needle/names.h ==== */
/* names: the exported names of a float build end in _f32, so that a float caller and a double object do
 * not link. Written by src/amalgamate.c from the declarations: do not edit. */
#ifndef NDLI_NAMES_H
#define NDLI_NAMES_H

#if defined(SB_REAL)
#define NDLI_NAMES_PASTE_(a, b) a##b
#define NDLI_NAMES_PASTE(a, b) NDLI_NAMES_PASTE_(a, b)
#define NDLI_NAMES_OF_double 0
#define NDLI_NAMES_OF_float 1
#if NDLI_NAMES_PASTE(NDLI_NAMES_OF_, SB_REAL)
#define ndl_rod_section_preset ndl_rod_section_preset_f32
#define ndl_rod_stiffness_of ndl_rod_stiffness_of_f32
#define ndl_default_rod_def ndl_default_rod_def_f32
#define ndl_rod_create ndl_rod_create_f32
#define ndl_rod_destroy ndl_rod_destroy_f32
#define ndl_rod_hold ndl_rod_hold_f32
#define ndl_rod_release ndl_rod_release_f32
#define ndl_rod_turn ndl_rod_turn_f32
#define ndl_rod_release_turn ndl_rod_release_turn_f32
#define ndl_rod_hold_base ndl_rod_hold_base_f32
#define ndl_rod_set_force ndl_rod_set_force_f32
#define ndl_rod_set_torque ndl_rod_set_torque_f32
#define ndl_rod_set_gravity ndl_rod_set_gravity_f32
#define ndl_rod_set_damping ndl_rod_set_damping_f32
#define ndl_rod_set_grip ndl_rod_set_grip_f32
#define ndl_rod_step ndl_rod_step_f32
#define ndl_default_rod_static_options ndl_default_rod_static_options_f32
#define ndl_rod_solve_static ndl_rod_solve_static_f32
#define ndl_rod_set_positions ndl_rod_set_positions_f32
#define ndl_rod_set_velocities ndl_rod_set_velocities_f32
#define ndl_rod_split_edge ndl_rod_split_edge_f32
#define ndl_rod_merge_node ndl_rod_merge_node_f32
#define ndl_rod_feed ndl_rod_feed_f32
#define ndl_rod_reparameterise ndl_rod_reparameterise_f32
#define ndl_rod_node_count ndl_rod_node_count_f32
#define ndl_rod_positions ndl_rod_positions_f32
#define ndl_rod_velocities ndl_rod_velocities_f32
#define ndl_rod_mass ndl_rod_mass_f32
#define ndl_rod_rest_length ndl_rod_rest_length_f32
#define ndl_rod_frame ndl_rod_frame_f32
#define ndl_rod_tip ndl_rod_tip_f32
#define ndl_rod_curvature ndl_rod_curvature_f32
#define ndl_rod_twist ndl_rod_twist_f32
#define ndl_rod_energies ndl_rod_energies_f32
#define ndl_rod_forces ndl_rod_forces_f32
#define ndl_rod_reactions ndl_rod_reactions_f32
#define ndl_rod_reaction_torque ndl_rod_reaction_torque_f32
#define ndl_rod_grip_torque ndl_rod_grip_torque_f32
#define ndl_rod_base_wrench ndl_rod_base_wrench_f32
#define ndl_default_remesh_def ndl_default_remesh_def_f32
#define ndl_remesh_create ndl_remesh_create_f32
#define ndl_remesh_destroy ndl_remesh_destroy_f32
#define ndl_remesh_reserve ndl_remesh_reserve_f32
#define ndl_remesh_puncture ndl_remesh_puncture_f32
#define ndl_remesh_penetrate ndl_remesh_penetrate_f32
#define ndl_remesh_retract ndl_remesh_retract_f32
#define ndl_remesh_withdraw ndl_remesh_withdraw_f32
#define ndl_remesh_nodes ndl_remesh_nodes_f32
#define ndl_remesh_limit ndl_remesh_limit_f32
#define ndl_remesh_material_point ndl_remesh_material_point_f32
#define ndl_remesh_hit ndl_remesh_hit_f32
#define ndl_remesh_split_count ndl_remesh_split_count_f32
#define ndl_remesh_quality ndl_remesh_quality_f32
#define ndl_remesh_is_original ndl_remesh_is_original_f32
#define ndl_remesh_check ndl_remesh_check_f32
#define ndl_helix_pose ndl_helix_pose_f32
#define ndl_tip_turn ndl_tip_turn_f32
#define ndl_helix_radius ndl_helix_radius_f32
#define ndl_helix_pitch ndl_helix_pitch_f32
#define ndl_bevel_offset ndl_bevel_offset_f32
#define ndl_bevel_shift ndl_bevel_shift_f32
#define ndl_bevel_curvature ndl_bevel_curvature_f32
#define ndl_obstacle_distance ndl_obstacle_distance_f32
#define ndl_default_plan_def ndl_default_plan_def_f32
#define ndl_plan_make ndl_plan_make_f32
#define ndl_plan_pose ndl_plan_pose_f32
#define ndl_default_steer_def ndl_default_steer_def_f32
#define ndl_steer_begin ndl_steer_begin_f32
#define ndl_steer_update ndl_steer_update_f32
#define ndl_default_push_def ndl_default_push_def_f32
#define ndl_push_begin ndl_push_begin_f32
#define ndl_push_update ndl_push_update_f32
#define ndl_push_choose ndl_push_choose_f32
#define ndl_default_guide_def ndl_default_guide_def_f32
#define ndl_guide_make ndl_guide_make_f32
#define ndl_default_needle_def ndl_default_needle_def_f32
#define ndl_needle_create ndl_needle_create_f32
#define ndl_needle_destroy ndl_needle_destroy_f32
#define ndl_needle_move_base ndl_needle_move_base_f32
#define ndl_step ndl_step_f32
#define ndl_needle_rod ndl_needle_rod_f32
#define ndl_needle_tip ndl_needle_tip_f32
#define ndl_needle_base_wrench ndl_needle_base_wrench_f32
#define ndl_needle_entry ndl_needle_entry_f32
#define ndl_needle_body_node ndl_needle_body_node_f32
#define ndl_needle_remesh ndl_needle_remesh_f32
#define ndl_needle_contact ndl_needle_contact_f32
#define ndl_needle_contact_force ndl_needle_contact_force_f32
#define ndl_needle_depth ndl_needle_depth_f32
#define ndl_needle_fed ndl_needle_fed_f32
#define ndl_needle_advance ndl_needle_advance_f32
#define ndl_needle_cutting ndl_needle_cutting_f32
#define ndl_needle_tip_material ndl_needle_tip_material_f32
#define ndl_rod_state_size ndl_rod_state_size_f32
#define ndl_rod_save ndl_rod_save_f32
#define ndl_rod_load ndl_rod_load_f32
#endif
#endif

#endif /* NDLI_NAMES_H */

/* ==== src/needle/api.h ==== */
/* api: version and linkage of needle.h. Results, errors, allocator, vectors and the scalar type are softbody.h's. */
#ifndef NDL_API_H
#define NDL_API_H


#define NDL_VERSION_MAJOR 0
#define NDL_VERSION_MINOR 5
#define NDL_VERSION_PATCH 0
#define NDL_VERSION_STRING "0.5.0"

#if NDL_VERSION_MAJOR != SB_VERSION_MAJOR || NDL_VERSION_MINOR != SB_VERSION_MINOR ||                                  \
    NDL_VERSION_PATCH != SB_VERSION_PATCH
#error "needle.h and softbody.h are of different versions: take both from one release"
#endif
#if defined(SB_NO_GEOMETRY)
#error "needle.h needs the surfaces of softbody.h: leave SB_NO_GEOMETRY undefined"
#endif
#if defined(NDL_IMPLEMENTATION) && !defined(SB_IMPLEMENTATION)
#error "needle.h: define NDL_IMPLEMENTATION in the file that defines SB_IMPLEMENTATION"
#endif

/* NDL_API: what stands before each public function: static under SB_STATIC or NDL_STATIC; exported or imported under
 * SB_SHARED, as NDL_IMPLEMENTATION says; your own where you define it, or SB_API, before including. NDLI_API: internal
 * functions; static in the shipped header, extern when the rooms are compiled apart. */
#if defined(NDL_API)
/* the caller's */
#elif defined(SB_STATIC) || defined(NDL_STATIC)
#define NDL_API static SBI_UNUSED
#elif defined(SBI_API_IS_GIVEN)
#define NDL_API SB_API
#elif defined(SB_SHARED) && defined(NDL_IMPLEMENTATION)
#define NDL_API SBI_EXPORT
#elif defined(SB_SHARED)
#define NDL_API SBI_IMPORT
#else
#define NDL_API SBI_EXTERN
#endif
#undef NDL_STATIC /* a state of the coupling has this name */
#if defined(SB_SPLIT_BUILD)
#define NDLI_API extern
#else
#define NDLI_API static SBI_UNUSED
#endif

#endif /* NDL_API_H */

/* ==== src/needle/rod.h ==== */
/* rod: a discrete elastic rod: a needle's stretching, bending and twisting, with or without tissue. Floor 6.
 *
 * A rod is a chain of nodes x_0 (base) ... x_n-1 (tip) and the edges e_j = x_j+1 - x_j between them. Each edge carries
 * a material frame (m1, m2, t): t along the edge, m1 and m2 across it, which says how the rod is turned about its own
 * axis. Twist runs along a rod faster than anything a step resolves, so frames have no inertia: they always minimise
 * the energy (Bergou et al. 2008, "Discrete elastic rods"; 2010 for the frames carried in time). */
#ifndef NDL_ROD_H
#define NDL_ROD_H


/* Functions that return an sb_result refuse a NULL rod; the others need one. */
typedef struct ndl_rod ndl_rod;

/* ---- what a rod is made of ---- */

/* A round wire or tube of one material. */
typedef struct ndl_rod_section {
    sb_real radius;       /* outer (m), > 0 */
    sb_real inner_radius; /* m, in [0, radius); 0: a wire */
    sb_real young;        /* Pa, > 0 */
    sb_real poisson;      /* in (-1, 0.5] */
    sb_real density;      /* kg/m^3, > 0 */
} ndl_rod_section;

typedef enum ndl_rod_preset {
    NDL_STYLET_18G = 1,    /* 18-gauge brachytherapy stylet: steel wire of 1.27 mm */
    NDL_NITINOL_083 = 2,   /* steerable nitinol wire of 0.83 mm (the needle of Webster et al. 2005, Int. Symp.
                            * Experimental Robotics, and of the phantom studies after it) */
    NDL_HYPODERMIC_22G = 3 /* 22-gauge steel tube, 0.7176 mm outside, 0.413 mm inside */
} ndl_rod_preset;

/* The section of a known needle. Diameters: regular-wall gauge table after the Birmingham wire gauge (18 G: 1.270
 * mm, 22 G: 0.7176 / 0.413 mm). Steel: AISI 304, annealed, 193 GPa, 0.29, 8000 kg/m^3. Nitinol: austenite, 75 GPa,
 * 0.33, 6450 kg/m^3 (makers' sheets: 75 to 83 GPa; linear up to a strain of about 1 % only). SB_ERROR_ARGUMENT for
 * an unknown preset leaves *section untouched. */
NDL_API sb_result ndl_rod_section_preset(ndl_rod_preset preset, ndl_rod_section *section);

/* Stiffnesses of a rod; ndl_rod_stiffness_of makes them from a section. */
typedef struct ndl_rod_stiffness {
    sb_real stretch;      /* EA (N), > 0 */
    sb_real bending[2];   /* EI (N m^2), > 0, against curvature towards m1 and towards m2 */
    sb_real twist;        /* GJ (N m^2), > 0 */
    sb_real line_density; /* mass per length (kg/m), > 0 */
} ndl_rod_stiffness;

/* E A, E pi (r^4 - ri^4)/4 twice, bending/(1 + nu), rho A. The section must be valid. */
NDL_API ndl_rod_stiffness ndl_rod_stiffness_of(const ndl_rod_section *section);

/* ---- creation ---- */

/* The shape in which a rod has no bending energy. */
typedef enum ndl_rod_rest {
    NDL_REST_STRAIGHT = 1, /* straight, with edges as long as given */
    NDL_REST_SHAPE = 2,    /* as the nodes are given: a pre-bent needle */
    NDL_REST_CURVATURE = 3 /* with the curvatures of def.rest_curvature */
} ndl_rod_rest;

/* What a rod is made from. Start from ndl_default_rod_def(), set nodes, change what you like. */
typedef struct ndl_rod_def {
    const sb_vec3 *nodes; /* [node_count] (m) first positions, base first; neighbours apart, no edge turned back on
                           * the one before (turns below 2.8 rad). Read during creation only, as all pointers here */
    int node_count;       /* >= 2 */
    int capacity;         /* most nodes the rod will ever have (see splitting), >= node_count; default 0: node_count */
    ndl_rod_section section;            /* default NDL_STYLET_18G */
    const ndl_rod_stiffness *stiffness; /* overrules the section; default NULL */
    ndl_rod_rest rest;                  /* default NDL_REST_STRAIGHT */
    const sb_real *rest_curvature; /* [node_count][2] (1/m) for NDL_REST_CURVATURE: curvature towards m1 and towards m2
                                    * at each node; those of the two ends are not used */
    sb_vec3 director; /* m1 of the first edge, projected to be across it and made a unit vector; default 0: any */
    int clamped;      /* 1 (default): nodes 0 and 1 and the frame of edge 0 are held. 0: free */
    sb_vec3 gravity;  /* m/s^2; default 0 */
    sb_real damping_stretch; /* s, >= 0: viscous stress is this times the rate of the elastic one; default 1e-4 */
    sb_real damping_bending; /* s, >= 0; the same for bending. It acts on the rate of the curvature vector, so that it
                              * also slows, weakly, a bent rod that tumbles as a whole; default 1e-4 */
    int max_newton;    /* Newton iterations of a step: 1 is one linear system, as in a coupled needle; default 30 */
    sb_real tolerance; /* out-of-balance force that a step leaves, relative to the largest, (0, 1); default 1e-6 */
    sb_allocator allocator; /* default malloc */
    unsigned cookie;        /* set by ndl_default_rod_def; a def made without it is refused */
} ndl_rod_def;

NDL_API ndl_rod_def ndl_default_rod_def(void);

/* Creates a rod at rest, with no twist but what its rest shape asks for. All memory it will ever need is taken here.
 * On failure *rod is untouched: SB_ERROR_ARGUMENT and SB_ERROR_NOT_FINITE (field or node named), SB_ERROR_MESH (node
 * named: an edge without length, or one turned back), SB_ERROR_MEMORY. */
NDL_API sb_result ndl_rod_create(const ndl_rod_def *def, ndl_rod **rod, sb_error *error);
NDL_API void ndl_rod_destroy(ndl_rod *rod); /* NULL is fine */

/* ---- supports and loads: stay until changed ----
 * SB_ERROR_INDEX, SB_ERROR_NOT_FINITE and SB_ERROR_ARGUMENT change nothing. */

/* From the next step or static solve on the node is held at `position` (m), with `velocity` (m/s) at the end of the
 * step; NULL: the mean velocity of its way there. Where both nodes of an end edge are held the end is clamped: the
 * tangent is given at the inner one of them. */
NDL_API sb_result ndl_rod_hold(ndl_rod *rod, int node, sb_vec3 position, const sb_vec3 *velocity);
NDL_API sb_result ndl_rod_release(ndl_rod *rod, int node);
/* The material frame of an edge is held and will turn by `angle` (rad, any size) about the edge's tangent in the next
 * step or static solve; otherwise it turns only as the edge does. */
NDL_API sb_result ndl_rod_turn(ndl_rod *rod, int edge, sb_real angle);
NDL_API sb_result ndl_rod_release_turn(ndl_rod *rod, int edge);
/* The base as a sleeve holds it: node 0 at `position`, edge 0 along `tangent` (any length but 0) at its rest length, m1
 * along `director` (projected). The frame is turned there the short way: less than half a turn from the last one,
 * carried along with the tangent. velocity (m/s) of the sleeve's point and angular_velocity (rad/s); both NULL or
 * both given. */
NDL_API sb_result ndl_rod_hold_base(ndl_rod *rod, sb_vec3 position, sb_vec3 tangent, sb_vec3 director,
                                    const sb_vec3 *velocity, const sb_vec3 *angular_velocity);
/* Dead force (N) on a node, and torque (N m) about its tangent on an edge; they replace those before. */
NDL_API sb_result ndl_rod_set_force(ndl_rod *rod, int node, sb_vec3 force);
NDL_API sb_result ndl_rod_set_torque(ndl_rod *rod, int edge, sb_real torque);
NDL_API sb_result ndl_rod_set_gravity(ndl_rod *rod, sb_vec3 gravity);
NDL_API sb_result ndl_rod_set_damping(ndl_rod *rod, sb_real stretch, sb_real bending);

/* What surrounds an edge holds it against turning about its tangent: a torsion spring of this stiffness (N m/rad, >= 0;
 * 0: none, the default) that slips at the torque `limit` (N m, >= 0). In each motion it is wound by the turn of the
 * material frame beyond what the edge's own way asks for. It replaces the grip before: a stiffer one keeps the torque
 * (what comes to it is not yet wound), a softer one how far it is wound, both up to the new limit. For a grip per
 * length give both times the edge's length. When edges are split, merged or set anew, their halves, sums or shares
 * follow. */
NDL_API sb_result ndl_rod_set_grip(ndl_rod *rod, int edge, sb_real stiffness, sb_real limit);

/* ---- motion ---- */

/* What a step or static solve did; every call writes every field. */
typedef struct ndl_rod_info {
    int newton_iterations;
    sb_real residual; /* largest out-of-balance force over the largest force at work, at the last check */
    int capped;       /* 1: max_newton was reached before the tolerance, and the last state was taken */
    int damped;       /* 1: the step was taken by implicit Euler, because Newmark would have gained energy */
    sb_error error;
} ndl_rod_info;

/* Advances the rod by dt (s, > 0) with Newmark's average acceleration (beta 1/4, gamma 1/2: second order),
 *     M a' = f(x', v'),  x' = x + dt v + dt^2 (a + a')/4,  v' = v + dt (a + a')/2,
 * by Newton's method with a banded direct solve, frames eliminated together with the nodes; each iteration lowers the
 * step's potential. While supports and loads do not change the energy is watched: a step that would raise it above
 * where it was when they last changed by more than 1 % of what is in motion and in strain is taken by implicit Euler,
 * which only loses energy. Without supports linear momentum is kept to rounding.
 * info may be NULL. On failure (SB_ERROR_ARGUMENT; SB_ERROR_UNCONSTRAINED: a torque about a rod no edge of which is
 * held; SB_ERROR_DIVERGED) the rod is as before the call, to the last bit. Allocates nothing; cost grows with
 * node_count, about 30 us for 20 nodes and an iteration. */
NDL_API sb_result ndl_rod_step(ndl_rod *rod, sb_real dt, ndl_rod_info *info);

/* How a static solve goes about its work. Start from ndl_default_rod_static_options(). */
typedef struct ndl_rod_static_options {
    int max_newton;    /* >= 1; default 500 */
    sb_real tolerance; /* largest out-of-balance force over the largest force at work, (0, 1); default 1e-9, or what
                        * rounding of positions leaves of it */
    unsigned cookie;   /* set by ndl_default_rod_static_options */
} ndl_rod_static_options;

NDL_API ndl_rod_static_options ndl_default_rod_static_options(void);

/* Finds the equilibrium nearest downhill under the present loads and supports; velocities become 0. Newton with the
 * exact Hessian of stretch, bending and twist where that is positive definite; where it is not, the lower end of two
 * steps: of the same with the least diagonal that makes it so, and of Gauss-Newton. At a buckling load that takes some
 * 30 iterations, well beyond it up to 110. Steps turn edges rather than stretch them, and a line search lets the energy
 * only fall. Supports move there in pieces
 * when their way is long. A straight rod under more than its buckling load is in equilibrium and stays so until
 * something pushes it aside. options and info may be NULL. On failure (SB_ERROR_ARGUMENT; SB_ERROR_UNCONSTRAINED:
 * the supports leave the rod free to move; SB_ERROR_NOT_CONVERGED; SB_ERROR_DIVERGED) the rod is as before the call.
 * Allocates nothing. */
NDL_API sb_result ndl_rod_solve_static(ndl_rod *rod, const ndl_rod_static_options *options, ndl_rod_info *info);

/* Overwrites positions [node_count] or velocities [node_count]; frames follow as if the rod had been moved there.
 * SB_ERROR_NOT_FINITE, SB_ERROR_MESH (node named) change nothing. */
NDL_API sb_result ndl_rod_set_positions(ndl_rod *rod, const sb_vec3 *positions, sb_error *error);
NDL_API sb_result ndl_rod_set_velocities(ndl_rod *rod, const sb_vec3 *velocities);

/* ---- changing the number of nodes ----
 * Neither changes the tip, the total rest length, the mass or the momentum. SB_ERROR_INDEX, SB_ERROR_UNSUPPORTED (no
 * capacity left; nothing left to merge) change nothing. */

/* A new node j + 1 in the middle of edge j, on the cubic through both ends with their tangents; it is held when both
 * were. */
NDL_API sb_result ndl_rod_split_edge(ndl_rod *rod, int edge);
/* Takes the inner node out: its edges become one. */
NDL_API sb_result ndl_rod_merge_node(ndl_rod *rod, int node);
/* Feeds `length` (m, either sign) of rod through the base: edge 1 gets longer or shorter at rest. SB_ERROR_ARGUMENT
 * when nothing would be left of it, or the rod has no edge 1. */
NDL_API sb_result ndl_rod_feed(ndl_rod *rod, sb_real length);

/* Gives the rod other nodes, `count` of them, on (about) its own curve; the first and the last should be its ends. What
 * it carries follows by arc distance, scaled so that both ends agree: velocities and accelerations linearly, rest
 * lengths, rest curvature and material frames by Akima's interpolation. Total rest length, mass and linear momentum
 * stay, and so does the material frame of edge 0; the rest length of edge 0, too, where its nodes are held. Supports
 * and loads of nodes 0 and 1 and of edge 0 stay, all others are dropped. positions [count] (m) are read during the
 * call. SB_ERROR_ARGUMENT, SB_ERROR_UNSUPPORTED (count above capacity), SB_ERROR_NOT_FINITE and SB_ERROR_MESH (node
 * named: an edge without length, or one turned back) change nothing. Allocates nothing. Source: Chentanez 2010,
 * section 9.2. */
NDL_API sb_result ndl_rod_reparameterise(ndl_rod *rod, const sb_vec3 *positions, int count, sb_error *error);

/* ---- readings: no allocation ---- */
NDL_API int ndl_rod_node_count(const ndl_rod *rod);
NDL_API const sb_vec3 *ndl_rod_positions(const ndl_rod *rod);      /* [node_count] (m), valid until destroyed */
NDL_API const sb_vec3 *ndl_rod_velocities(const ndl_rod *rod);     /* [node_count] (m/s) */
NDL_API sb_real ndl_rod_mass(const ndl_rod *rod, int node);        /* kg */
NDL_API sb_real ndl_rod_rest_length(const ndl_rod *rod, int edge); /* m */

/* Orthonormal, right-handed: m1 x m2 = t. */
typedef struct ndl_frame {
    sb_vec3 m1, m2, t;
} ndl_frame;
/* Material frame of an edge, 0 <= edge < node_count - 1. */
NDL_API ndl_frame ndl_rod_frame(const ndl_rod *rod, int edge);
/* Tip position (m) and the frame of the last edge; either may be NULL. */
NDL_API void ndl_rod_tip(const ndl_rod *rod, sb_vec3 *position, ndl_frame *frame);
/* Curvature (1/m) at an inner node, 0 < node < node_count - 1, towards m1 and m2 (mean of the two edges' frames). */
NDL_API void ndl_rod_curvature(const ndl_rod *rod, int node, sb_real curvature[2]);
/* Twist (rad) at an inner node: the turn of the material frame from one edge to the next beyond parallel transport. */
NDL_API sb_real ndl_rod_twist(const ndl_rod *rod, int node);

typedef struct ndl_rod_energy {
    sb_real stretch, bend, twist, kinetic; /* J */
    sb_real grip;                          /* J: in the springs of ndl_rod_set_grip */
} ndl_rod_energy;
NDL_API ndl_rod_energy ndl_rod_energies(const ndl_rod *rod);
/* Elastic and viscous force (N) on every node from the present state, forces[node_count]: minus the gradient of the
 * elastic energy at fixed material frames, and the damping. */
NDL_API void ndl_rod_forces(ndl_rod *rod, sb_vec3 *forces);
/* Force (N) of the supports on each node in the last step or static solve, 0 where free; [node_count]. */
NDL_API const sb_vec3 *ndl_rod_reactions(const ndl_rod *rod);
/* Torque (N m) about the tangent that holds an edge's frame, in the last step or static solve; 0 where free. */
NDL_API sb_real ndl_rod_reaction_torque(const ndl_rod *rod, int edge);
/* Torque (N m) about the tangent with which the surroundings' grip turns an edge; 0 where there is none. */
NDL_API sb_real ndl_rod_grip_torque(const ndl_rod *rod, int edge);
/* What holds the base, as force (N) and torque (N m) about node 0 on the rod: what a hand feels is the opposite. */
NDL_API void ndl_rod_base_wrench(const ndl_rod *rod, sb_vec3 *force, sb_vec3 *torque);

#endif /* NDL_ROD_H */

/* ==== src/needle/topology.h ==== */
/* topology: what a remesher knows of a body's tet4 mesh: rings, neighbours, qualities, and how it changes. Floor 6,
 * internal.
 *
 * Slots of nodes and tets are the body's. A change is made here first, while candidates are compared and undone; the
 * remesher then hands it to the body as one change of its mesh. */
#ifndef NDL_TOPOLOGY_H
#define NDL_TOPOLOGY_H


/* Where a segment enters a body. */
typedef struct ndl_surface_hit {
    int tet, face; /* face opposite node `face` of the tet (a cell of the body) */
    sb_real along; /* 0 at `from`, 1 at `to` */
    sb_vec3 X;     /* material position of the point (m) */
} ndl_surface_hit;


#endif /* NDL_TOPOLOGY_H */

/* ==== src/needle/remesh.h ==== */
/* remesh: keeps a node of the tissue at the tip of every needle, and a path of edges along what is inserted. Floor 6.
 * Chapter 9 of Chentanez 2010: node snaps and edge, face and tet splits round the tip, the best of them by the quality
 * of the mesh they leave, and a stack of undone splits, so that the tissue is the original one after the needle. */
#ifndef NDL_REMESH_H
#define NDL_REMESH_H


/* What a needle may do to the faces between regions. They follow the tip by parts of a tet either way, or no node could
 * pass them: the volume of each region is not kept, nor, where densities differ, the mass of the body; all of it is
 * undone at the end. */
typedef enum ndl_interface_rule {
    NDL_INTERFACE_KEEP_NODES = 0, /* their edges and faces are split, their nodes stay where they are: a tip just
                                   * behind one has flat tets about it, as just below the skin */
    NDL_INTERFACE_MOVE = 1        /* their nodes are snapped like any others: better tets, coarser regions */
} ndl_interface_rule;

/* How to remesh. Start from ndl_default_remesh_def(). */
typedef struct ndl_remesh_def {
    sb_body *body;                 /* of tet4, borrowed; outlives the remesher. Its mesh changes from then on */
    int max_needles;               /* >= 1; needles are numbered from 0. Default 4 */
    ndl_interface_rule interfaces; /* default NDL_INTERFACE_MOVE */
    sb_real smooth_below;   /* free nodes about the tip are moved while a tet there is worse than this; in [0, 1).
                             * Default 0.55; 0: never, as in the thesis */
    sb_real release_above;  /* nodes go back towards their own place, and splits that no needle needs are undone,
                             * where that leaves tets at least this good, or no worse; in [0, 1]. Default 0.6 */
    int max_smoothed;       /* nodes moved per operation at most, >= 0. Default 16 */
    sb_real entry_slip;     /* a puncture that leaves tets worse than half of smooth_below, when what lies below has
                             * made way, may go to a node or edge of the skin not further away than this share of the
                             * face's longest edge: where the skin is not flat, no node of it can be moved to the
                             * needle; in [0, 1]. Default 0.25 */
    sb_allocator allocator; /* default malloc */
    unsigned cookie;        /* set by ndl_default_remesh_def */
} ndl_remesh_def;

NDL_API ndl_remesh_def ndl_default_remesh_def(void);

typedef struct ndl_remesh ndl_remesh;

typedef enum ndl_operation {
    NDL_NO_OPERATION = 0,
    NDL_NODE_SNAP = 1, /* a node was moved to the tip */
    NDL_EDGE_SPLIT = 2,
    NDL_FACE_SPLIT = 3,
    NDL_TET_SPLIT = 4
} ndl_operation;

/* What a call did. */
typedef struct ndl_remesh_info {
    ndl_operation operation; /* the last one */
    int undone;              /* 1: the split that made the old tip was taken back before it */
    int substeps;            /* operations done */
    int candidates;          /* operations compared */
    int smoothed, released;  /* nodes moved for quality, and back towards their own place */
    int outside;             /* 1: the point lies outside the tissue. Penetrating: nothing was done. Retracting: the
                              * needle has left the tissue */
    sb_real worst_quality;   /* of the tets about the tip and the node next to it; 1 when the needle is out */
    sb_vec3 X;               /* where the tip is in the material (m) */
} ndl_remesh_info;

/* SB_ERROR_ARGUMENT (field named; the body has a remesher already), _UNSUPPORTED (elements other than SB_TET4;
 * def.slack was 0), _MEMORY leave *remesh untouched. While it has changed the mesh, changes by others are refused
 * (SB_ERROR_STATE).
 *
 * From now on the remesher is part of the body's saved state, its hash and its recording: sb_body_state_load asks for a
 * body with a remesher of the same def, and brings needles, splits and what is needed to undo them back to the last
 * bit. A recording of the body holds the calls below; it is played on a body with such a remesher. Make remeshers
 * before a recording is started, and destroy them after it has been stopped: what follows otherwise is refused when it
 * is played. */
NDL_API sb_result ndl_remesh_create(const ndl_remesh_def *def, ndl_remesh **remesh, sb_error *error);
/* Leaves the body as it is. Safe on NULL. */
NDL_API void ndl_remesh_destroy(ndl_remesh *remesh);

/* Takes the memory that a needle of up to so many nodes in the tissue usually needs, so that calls ask for none while
 * the mesh keeps to its slack. SB_ERROR_INDEX, _ARGUMENT (nodes < 0) and _MEMORY change nothing that can be seen. */
NDL_API sb_result ndl_remesh_reserve(ndl_remesh *remesh, int needle, int nodes, sb_error *error);

/* In all calls `needle` is in [0, max_needles) (SB_ERROR_INDEX) and `info` and `error` may be NULL. Each operation
 * happens as a whole or, when the call fails at it, not at all: SB_ERROR_MEMORY; SB_ERROR_NOT_FINITE;
 * SB_ERROR_ARGUMENT, a needle that is (not) in the tissue; SB_ERROR_MESH, no operation leaves sound tets: the step is
 * too long; SB_ERROR_UNSUPPORTED, every operation would change an element of another needle; and what the body or those
 * that follow its mesh refuse (see sb_body_change_commit). */

/* First contact: puts a node where the skin was hit, which is the needle's entry from then on, and its tip until it
 * goes deeper. The skin keeps its shape: nodes of it move within flat parts only, edges are split where the point lies
 * on them or their faces are in one plane; but see entry_slip. info->X: where the entry is. */
NDL_API sb_result ndl_remesh_puncture(ndl_remesh *remesh, int needle, const ndl_surface_hit *hit, ndl_remesh_info *info,
                                      sb_error *error);
/* The tip cuts on (retracts) to X_new (m, in the material), by as many operations as ndl_remesh_limit asks for, in a
 * straight line. After a failure it stays where the last operation brought it. A point outside: see
 * ndl_remesh_info.outside. */
NDL_API sb_result ndl_remesh_penetrate(ndl_remesh *remesh, int needle, sb_vec3 X_new, ndl_remesh_info *info,
                                       sb_error *error);
NDL_API sb_result ndl_remesh_retract(ndl_remesh *remesh, int needle, sb_vec3 X_new, ndl_remesh_info *info,
                                     sb_error *error);
/* The needle leaves: its nodes are released and its splits undone. When no other needle is in, the mesh is the
 * original one, number by number and place by place; else what a near needle prevents follows later. Where the body
 * refuses (SB_ERROR_MEMORY) it stays in. Does nothing for a needle that is not in. */
NDL_API sb_result ndl_remesh_withdraw(ndl_remesh *remesh, int needle, ndl_remesh_info *info, sb_error *error);

/* Nodes of the needle in the tissue, entry first, tip last; consecutive ones are joined by an edge. NULL and 0 when it
 * is not in. Valid until the next call. */
NDL_API const int *ndl_remesh_nodes(const ndl_remesh *remesh, int needle, int *count);
/* How far one operation may take the tip (m): half the shortest edge at the tip, but for the needle's own. */
NDL_API sb_real ndl_remesh_limit(const ndl_remesh *remesh, int needle);
/* Material position of a point in space, looked for from the tip; 0 when it is outside (*X is then the continuation of
 * the nearest tet's map), else 1. */
NDL_API int ndl_remesh_material_point(const ndl_remesh *remesh, int needle, sb_vec3 x, sb_vec3 *X);
/* First face of the body's surface that the segment crosses from outside in space (m); 0 and *hit untouched when there
 * is none. O(tets): for a needle that is not in yet. */
NDL_API int ndl_remesh_hit(const ndl_remesh *remesh, sb_vec3 from, sb_vec3 to, ndl_surface_hit *hit);
/* Splits not undone yet. */
NDL_API int ndl_remesh_split_count(const ndl_remesh *remesh, int needle);
/* How good the mesh is in the material; any place may be NULL. Quality: 6 sqrt(2) V / l_rms^3, 1 for the regular tet;
 * angles in degrees. O(tets). */
NDL_API void ndl_remesh_quality(const ndl_remesh *remesh, sb_real *worst_quality, sb_real *min_dihedral,
                                sb_real *max_dihedral);
/* 1 when the mesh is the one that the remesher was made on, number by number and place by place. */
NDL_API int ndl_remesh_is_original(const ndl_remesh *remesh);
/* Whether what the remesher knows of the mesh is consistent and the body's: for tests. SB_ERROR_MESH names the first
 * fault. */
NDL_API sb_result ndl_remesh_check(const ndl_remesh *remesh, sb_error *error);


#endif /* NDL_REMESH_H */

/* ==== src/needle/steer.h ==== */
/* steer: where a bevelled needle goes, plans of helices to a target past obstacles, a controller that follows them, and
 * one that pushes tissue so that a target moves onto a straight needle's path. Floor 6.
 *
 * A needle with a bevelled tip that is pushed into tissue bends towards one side; turning its base turns that side.
 * With a steady turn the tip draws a helix, with none a circle. All here works on the tip's pose alone: it needs no
 * tissue and no rod, only the curvature of the circles, which is measured (see ndl_bevel). Lengths in m, angles in rad.
 *
 *     ndl_steer_def def = ndl_default_steer_def(10, 0.15);   (radius 10 cm, at most 15 cm deep)
 *     ndl_steer steer;
 *     ndl_steer_command command;
 *     if (ndl_steer_begin(&def, &steer, &error) != SB_OK) ...
 *     do {                                                   (sense the tip and the target, then:)
 *         ndl_steer_update(&steer, &tip, target, &command);
 *         (insert command.insertion, turn the base by command.turn)
 *     } while (command.status == NDL_STEER_GOING);
 *
 * Nothing here allocates; calls on different objects are independent of each other. Sources: Webster et al. 2006
 * (nonholonomic model), Hauser et al. 2009 (feedback on helical paths), Torabi et al. 2009 (single-point manipulation),
 * Chentanez 2010, 10.1 and 12.2. */
#ifndef NDL_STEER_H
#define NDL_STEER_H


/* ---- where a tip goes ---- */

/* Position (m) of a tip and its frame: t points ahead, and the needle bends towards m2. */
typedef struct ndl_tip_pose {
    sb_vec3 position;
    ndl_frame frame; /* orthonormal and right-handed to 1e-3; used made exact */
} ndl_tip_pose;

/* The pose after `length` (m, either sign) of insertion at a steady twist (rad of turn per m of insertion, about t),
 * for a tip that bends with `curvature` (1/m). Exact for any size, also for 0. Pure turning is ndl_tip_turn. */
NDL_API ndl_tip_pose ndl_helix_pose(const ndl_tip_pose *start, sb_real curvature, sb_real twist, sb_real length);
/* The pose turned in place by `angle` about t. */
NDL_API ndl_tip_pose ndl_tip_turn(const ndl_tip_pose *start, sb_real angle);
/* Radius (m) of that helix, k/(k^2 + w^2), and its way ahead per turn, 2 pi |w|/(k^2 + w^2); k and w not both 0. */
NDL_API sb_real ndl_helix_radius(sb_real curvature, sb_real twist);
NDL_API sb_real ndl_helix_pitch(sb_real curvature, sb_real twist);

/* ---- what a bevel does in tissue ----
 * The way of a tip turns by a curvature as it goes on, towards m2. A needle (needle.h) that follows it in rigid tissue
 * goes in circles of that curvature. Soft tissue gives way, and the shaft bends over a length lam = (4 EI / k)^(1/4), k
 * its stiffness across (N/m^2): the way leaves the shaft's direction by an angle `lag` at most, which gives a curvature
 * of lag/lam there, whatever the mesh (with NDL_REMESH and NDL_BEVEL_CURVATURE the mesh's edges set that limit). A
 * turning bevel draws the helix of its turn (ndl_helix_pose), also from the skin on and with a turn of radians in a
 * step: its axis leaves the straight way by curvature/twist.
 *
 * For tips in meshes of your own: one that advances by d along t has its material point put aside by an offset h
 * against which the needle then bends: X <- X(x_tip) + F^-1 h m2. */

typedef enum ndl_bevel_law {
    NDL_BEVEL_ANGLE = 1,    /* the curvature is 2 tan(angle)/guide, the lag the angle. h = d tan(angle) */
    NDL_BEVEL_CURVATURE = 2 /* h = d tan(curvature (l + d)/2): circles in rigid tissue for any edge length l and step d;
                             * softer tissue gives less */
} ndl_bevel_law;

/* Of a needle, start from ndl_default_needle_def. */
typedef struct ndl_bevel {
    ndl_bevel_law law;
    sb_real angle;     /* rad, |angle| < 1.5; for NDL_BEVEL_ANGLE: between what the tip cuts and the shaft behind it. An
                        * effective angle of few degrees, not the ground one */
    sb_real curvature; /* 1/m, for NDL_BEVEL_CURVATURE. Measured: radii of 5 to 50 cm are usual; 0: symmetric tip */
    sb_real guide;     /* m, > 0, for NDL_BEVEL_ANGLE of a needle: length of shaft that guides the tip in rigid tissue.
                        * A needle's default 0.005 */
    sb_real lag;       /* rad, > 0, for NDL_BEVEL_CURVATURE of a needle. It can be measured in one soft gel: curvature
                        * times lam. A needle's default 0.1 */
} ndl_bevel;

/* Offset h (m) for an advance d (m) of a tip whose last edge is edge_length (m) long; 0 for d <= 0 (retraction).
 * SB_ERROR_ARGUMENT (law, angle, edge_length <= 0, or an edge too long for the circle: |curvature| (l + d) > 2) and
 * SB_ERROR_NOT_FINITE leave *offset untouched. */
NDL_API sb_result ndl_bevel_offset(const ndl_bevel *bevel, sb_real advance, sb_real edge_length, sb_real *offset);
/* The material displacement F^-1 (offset m2) of the tip's material point; F is the deformation gradient about the tip,
 * averaged by volume over the tip's star (that of one element jumps). SB_ERROR_INVERTED when det F <= 0,
 * SB_ERROR_NOT_FINITE; *shift is then untouched. */
NDL_API sb_result ndl_bevel_shift(sb_real offset, sb_vec3 m2, const sb_mat3 *deformation, sb_vec3 *shift);
/* Curvature (1/m) that a bevel gives in rigid tissue, with edges and advances as given (see above for errors). That of
 * a needle has advance 0, edge_length the bevel's guide. */
NDL_API sb_result ndl_bevel_curvature(const ndl_bevel *bevel, sb_real advance, sb_real edge_length, sb_real *curvature);

/* ---- obstacles ---- */

typedef enum ndl_obstacle_kind {
    NDL_OBSTACLE_SPHERE = 1,   /* centre a */
    NDL_OBSTACLE_CAPSULE = 2,  /* all within radius of the segment from a to b */
    NDL_OBSTACLE_CYLINDER = 3, /* flat ends at a and b, apart */
    NDL_OBSTACLE_SHAPE = 4     /* inside of a surface or a function. To stay inside an organ, negate its distance */
} ndl_obstacle_kind;

typedef struct ndl_obstacle {
    ndl_obstacle_kind kind;
    sb_vec3 a, b;          /* m */
    sb_real radius;        /* m, > 0 */
    const sb_shape *shape; /* for NDL_OBSTACLE_SHAPE, borrowed; a function needs its max_slope */
} ndl_obstacle;

/* Distance (m) of a point from an obstacle, negative inside; for functions of slopes up to max_slope their value
 * divided by it: never more than the distance. SB_REAL_MAX for NULL or a kind that is none; what
 * else is wrong with an obstacle ndl_plan_make says. */
NDL_API sb_real ndl_obstacle_distance(const ndl_obstacle *obstacle, sb_vec3 point);

/* ---- plans ---- */

enum { NDL_PLAN_PIECES = 3 }; /* most pieces of a plan */

/* First a turn in place, then an insertion at a steady twist. */
typedef struct ndl_plan_piece {
    sb_real turn;   /* rad, in [-pi, pi] */
    sb_real twist;  /* rad/m */
    sb_real length; /* m, >= 0 */
} ndl_plan_piece;

typedef enum ndl_plan_outcome {
    NDL_PLAN_REACHES = 1, /* ends within the tolerance of the target, clear of obstacles */
    NDL_PLAN_SHORT = 2,   /* clear of obstacles, but ends farther off: `distance` */
    NDL_PLAN_BLOCKED = 3  /* the tip is in an obstacle already: no pieces */
} ndl_plan_outcome;

typedef struct ndl_plan {
    ndl_plan_outcome outcome;
    int piece_count;
    ndl_plan_piece pieces[NDL_PLAN_PIECES];
    sb_real length;    /* m, of all pieces */
    sb_real distance;  /* m, from the end to the target */
    sb_real bound;     /* m: without obstacles no plan of one piece ends nearer than this; proven, see ndl_plan_make */
    sb_real clearance; /* m: no obstacle is nearer to the path, proven; SB_REAL_MAX without obstacles */
    int boxes;         /* boxes looked at by branch and bound: a measure of the work; 0 when not needed */
} ndl_plan;

/* What a plan may use. Start from ndl_default_plan_def. */
typedef struct ndl_plan_def {
    sb_real curvature;  /* 1/m, > 0 */
    sb_real max_length; /* m of insertion, > 0 */
    sb_real max_twist;  /* rad/m, >= 0; default 50 times the curvature */
    int turn;           /* 1 (default): the base may be turned with no insertion, at the start of each piece: every
                         * point the needle can bend to is met. 0: steady twist only, as in Hauser et al.: helices
                         * then leave gaps that are up to pi k/w^2 wide about a twist of w */
    sb_real tolerance;  /* m, in [1e-6 max_length, max_length]; default 1/1000 of the radius 1/curvature */
    int max_boxes;      /* most boxes of one search, >= 1; default 5000. When they run out `bound` is lower */
    const ndl_obstacle *obstacles; /* [obstacle_count], borrowed; default none. For a controller they may be moved, but
                                    * not added to, between updates */
    int obstacle_count;
    sb_real clearance; /* m from obstacles, >= 0: half the needle's diameter, and margin; default 1/200 of the
                        * radius */
    int max_pieces;    /* 1 ... NDL_PLAN_PIECES; default 3. More than one is used only where obstacles ask for it */
    int samples;       /* paths tried past obstacles for each number of pieces, >= 1; default 400 */
    unsigned cookie;   /* set by ndl_default_plan_def; a def made without it is refused */
} ndl_plan_def;

NDL_API ndl_plan_def ndl_default_plan_def(sb_real curvature, sb_real max_length);

/* The helix from the tip that ends nearest to the target (m), to the tolerance: branch and bound over length and twist,
 * after a descent from a few starts which mostly settles it. Where obstacles are in its way, sequences of pieces: the
 * first ones sampled and improved, the last one aimed at the target; of those that reach the target one that is short
 * and has room on both sides. A path ends where it is nearest: it is never inserted further. A tip nearer to an
 * obstacle than def.clearance keeps nine tenths of the distance it has. SB_OK with any outcome. SB_ERROR_ARGUMENT,
 * _NOT_FINITE (field or obstacle named) leave *plan untouched. 2 us where turning gets there, else about 0.3 ms (1 ms
 * where max_boxes run out), 1 to 10 ms past obstacles (without turning to 0.1 s). Deterministic to the bit. */
NDL_API sb_result ndl_plan_make(const ndl_plan_def *def, const ndl_tip_pose *tip, sb_vec3 target, ndl_plan *plan,
                                sb_error *error);
/* The pose `length` (m) along a plan, in [0, plan->length] (clamped), from the tip it was made for; at 0
 * with its first turn made. */
NDL_API ndl_tip_pose ndl_plan_pose(const ndl_plan *plan, sb_real curvature, const ndl_tip_pose *tip, sb_real length);

/* ---- feedback ---- */

typedef enum ndl_steer_status {
    NDL_STEER_GOING = 0,
    NDL_STEER_REACHED = 1, /* within def.reach of the target, and no nearer place ahead */
    NDL_STEER_CLOSEST = 2, /* can get no closer, but is not within def.reach */
    NDL_STEER_LIMIT = 3,   /* max_length is used up, or def.max_updates */
    NDL_STEER_BLOCKED = 4  /* no way on clear of the obstacles was found */
} ndl_steer_status;

/* What to do until the next update. Divide by the time step for speeds. */
typedef struct ndl_steer_command {
    ndl_steer_status status;
    sb_real insertion; /* m, >= 0; 0 when turning in place and when not going */
    sb_real turn;      /* rad to turn the base by, about t */
    sb_real distance;  /* m, from the sensed tip to the target */
    sb_real expected;  /* m, from the end of the present plan to the target */
} ndl_steer_command;

/* Start from ndl_default_steer_def. */
typedef struct ndl_steer_def {
    ndl_plan_def plan;  /* plan.max_length is that of the whole insertion */
    sb_real reserve;    /* share of the curvature, in [0, 1), that plans do not use, so that a needle that bends less
                         * than it should, or tissue that gives way, can be made up for; default 0.2 */
    sb_real step;       /* m of insertion per update, > 0; default 1/100 of the radius */
    sb_real max_turn;   /* rad per update, > 0; default 1 */
    sb_real turn_gain;  /* share of the tip's error in roll made good per update, in (0, 1]; default 0.5. Lower where
                         * the tip follows the base late */
    sb_real turn_first; /* rad: insertion waits while the roll is further off than this; default 0.3 */
    int max_wait;       /* updates it waits at a stretch, >= 0; default 40. Then it goes on */
    sb_real reach;      /* m, > 0: what counts as reached; default 1/100 of the radius */
    int max_updates;    /* >= 1; default 10000 */
    sb_real learn;      /* m of insertion, >= 0, over which the tip's way is averaged to learn where it really goes
                         * (see ndl_steer_update). Default 12/100 of the radius; shorter where the sensed position is
                         * good, longer where it is noisy; 0: the tip is taken to go where it looks, with the given
                         * curvature */
    unsigned cookie;    /* set by ndl_default_steer_def */
} ndl_steer_def;

/* curvature and max_length as in ndl_default_plan_def. */
NDL_API ndl_steer_def ndl_default_steer_def(sb_real curvature, sb_real max_length);

/* A controller: plain data, may be copied (a copy is its saved state). Fields are read-only. */
typedef struct ndl_steer {
    ndl_steer_def def;
    ndl_steer_status status;
    sb_real inserted;   /* m commanded */
    int updates, plans; /* plans: how often a way past the obstacles was searched */
    int waited;         /* updates of the present wait */
    int next_search;    /* the update from which a better way is looked for again, while the present one is clear */
    int waypoint_count;
    sb_vec3 waypoints[NDL_PLAN_PIECES - 1]; /* m, where the pieces before the last one end */
    ndl_plan plan;                          /* from the last sensed tip */
    sb_real curvature;                      /* 1/m: def.plan.curvature, as measured since: between half of it and all */
    sb_vec3 drift;                          /* the tip's way less where it looks, across: small angles (rad) */
    /* internal: what it is learned from */
    ndl_tip_pose tip; /* the last one sensed */
    sb_vec3 way;      /* unit: where it was found to go */
    sb_vec3 first;    /* t of the first one */
    sb_real advance;  /* m: what was inserted since */
    sb_real weight;   /* m^2: that of the present estimate of the curvature */
    int bends;        /* 1: the tip has been seen to bend, so it is in tissue */
} ndl_steer;

/* SB_ERROR_ARGUMENT and SB_ERROR_NOT_FINITE leave *steer untouched. */
NDL_API sb_result ndl_steer_begin(const ndl_steer_def *def, ndl_steer *steer, sb_error *error);
/* One round: the plan from the sensed tip to the sensed target (m; tissue moves it), and what to do. Pieces of a plan
 * past obstacles are aimed anew at where they were to end, and the way is searched anew when that is no longer clear.
 * The controller learns from the sensed tips, by averages that forget: how far their way leans from where they look
 * (soft tissue gives way sideways under a needle that bends) over def.learn of insertion, and with what curvature their
 * way turns over twice that. Plans begin along the way so found and use that curvature, which is never taken for more
 * than the given one or less than half of it, less def.reserve. It is only measured once the tip has turned by 0.05
 * rad: before, it may be in air.
 * Once the status is not GOING it stays and nothing more is commanded; ndl_steer_begin starts over. SB_ERROR_NOT_FINITE
 * and SB_ERROR_ARGUMENT (a frame that is none) change nothing. Cost: see ndl_plan_make. */
NDL_API sb_result ndl_steer_update(ndl_steer *steer, const ndl_tip_pose *tip, sb_vec3 target,
                                   ndl_steer_command *command);

/* ---- pushing the tissue ---- */

/* Start from ndl_default_push_def, set compliance, line and max_force. The gains have no unit but that of time: the
 * compliance turns errors into forces. */
typedef struct ndl_push_def {
    sb_mat3 compliance;     /* m/N: displacement of the point of interest per force of the manipulator. An estimate will
                             * do: off by a factor below 2, or 45 degrees */
    sb_vec3 line_point;     /* m, on the needle's path */
    sb_vec3 line_direction; /* any length but 0 */
    sb_real clear_radius;   /* m; 0 (default): move the point onto the path. > 0: out of a cylinder of this radius
                             * about it (an obstacle) */
    sb_vec3 direction;      /* in which the manipulator pushes, any length but 0; default 0: any direction (a grip) */
    sb_real cone;           /* rad, in [0, pi/2]: how far the force may lean from `direction`; default 0.5 */
    sb_real max_force;      /* N, > 0 */
    sb_real proportional;   /* >= 0, default 0.3. Tissue that follows at once needs less than 1 */
    sb_real integral;       /* 1/s, >= 0; default 1 */
    sb_real max_rate;       /* N/s, > 0; default SB_REAL_MAX */
    sb_real tolerance;      /* m, > 0: within it the push has arrived; default 5e-4 */
    unsigned cookie;        /* set by ndl_default_push_def */
} ndl_push_def;

NDL_API ndl_push_def ndl_default_push_def(void);

/* A PI controller: plain data, may be copied. Fields are read-only. */
typedef struct ndl_push {
    ndl_push_def def; /* directions made unit vectors */
    sb_vec3 integral; /* m: the integral part of the displacement asked for */
    sb_vec3 force;    /* N */
    sb_vec3 error;    /* m: way that the point has still to go, across the path; 0 when there */
    int arrived;      /* the last error was within the tolerance */
    int limited;      /* the force asked for was beyond the cone, max_force or max_rate */
} ndl_push;

/* SB_ERROR_ARGUMENT (field named; a compliance that moves nothing across the path), _NOT_FINITE leave *push untouched.
 * */
NDL_API sb_result ndl_push_begin(const ndl_push_def *def, ndl_push *push, sb_error *error);
/* From the sensed point of interest (m) after another dt (s, > 0) to the manipulator's force (N): the one within cone
 * and max_force that comes nearest to displacing the point by proportional error + integral of the error. While a limit
 * holds, the integral grows only where that leads away from the limit. SB_ERROR_ARGUMENT, _NOT_FINITE change nothing.
 * */
NDL_API sb_result ndl_push_update(ndl_push *push, sb_vec3 point, sb_real dt, sb_vec3 *force);

/* The cheapest of `count` places to push at: def with each compliance and direction (directions may be NULL: def's) in
 * turn, for a point of interest at `point`. *best: the index of the one that needs the least force, or, where none
 * brings the point all the way, of the one that leaves the least; *force (N) and *left (m, may both be NULL): that
 * force and what it leaves. SB_ERROR_ARGUMENT and _NOT_FINITE leave all untouched. */
NDL_API sb_result ndl_push_choose(const ndl_push_def *def, const sb_mat3 *compliances, const sb_vec3 *directions,
                                  int count, sb_vec3 point, int *best, sb_vec3 *force, sb_real *left, sb_error *error);

#endif /* NDL_STEER_H */

/* ==== src/needle/guide.h ==== */
/* guide: a straight needle's path to a target past tissue that it must not hit, found by chance and climbing, and what
 * to push, where and in which order, so that the path is free and meets the target. Floor 6.
 *
 *     ndl_guide_def def = ndl_default_guide_def(target, entry, direction);
 *     def.obstacles = nerves, def.obstacle_count = 2, def.clearance = 0.002;
 *     def.places = places, def.place_count = 6, def.max_force ... of each place
 *     def.model = compliance_of_my_tissue;
 *     ndl_guide_make(&def, &guide, &error);
 *     for (int k = 0; k < guide.phase_count; k++) {          (of phases that have a place)
 *         ndl_push_begin(&guide.phases[k].push, push + k, &error);
 *         (ndl_push_update of it and of those before it, with where their phases' points are now, until
 * push[k].arrived)
 *     }
 *     (insert along guide.direction from guide.entry, all pushes going on)
 *
 * A plan is for tissue that no needle moves. In a body a needle takes the target with it, tissue bends it: carry the
 * plan out in a simulation, put def.target off by where the target's material then is less the tip, make it again, and
 * so on until the tip meets it. In tests/test_guide_body.c targets are missed by 0.6 to 1.8 mm at first, by 0.02 to
 * 0.24 mm after the second plan and by at most 1 um after the fourth.
 *
 * Sources: Chentanez 2010, 12.2.2; Torabi et al. 2009: points of interest are where sensitive tissue enters a cylinder
 * about the path, one for each place where it is deepest; the deepest is moved out of the way first, the target onto
 * the path last; of many paths the one that asks for the least force is taken. */
#ifndef NDL_GUIDE_H
#define NDL_GUIDE_H


enum { NDL_GUIDE_PHASES = 8, NDL_GUIDE_PLACES = 32 };

/* Where tissue may be pushed, and with what. Several may be at one point: a finger and a grip. */
typedef struct ndl_push_place {
    sb_vec3 direction; /* in which it pushes, any length; 0: any direction (a grip) */
    sb_real cone;      /* rad, in [0, pi/2]: how far the force may lean from it */
    sb_real max_force; /* N, > 0 */
    sb_real weight;    /* > 0: what a newton costs here, beside other places */
} ndl_push_place;

/* The tissue: how the material point (m, at rest) is displaced by a force at a place, m/N, as far as is known: from a
 * static solve with three forces, or a table of those. 0: unknown; then the place is not used for that point. Finite.
 */
typedef int (*ndl_push_model)(void *user, sb_vec3 point, int place, sb_mat3 *compliance);

/* Start from ndl_default_guide_def. */
typedef struct ndl_guide_def {
    sb_vec3 target;           /* m, at rest */
    sb_vec3 entry, direction; /* m, and any length but 0: the middle of a disc across `direction` through which */
    sb_real entry_radius;     /* paths go, of this radius (m), >= 0; default 1/10 of its distance to the target. What
                               * lies before the disc is not looked at */
    sb_real max_lean;         /* rad, in [0, 1.5]: of paths from `direction`; default 0.6 */
    sb_real shift;            /* m, >= 0: how far from the target at rest paths may pass; default as entry_radius */
    const ndl_obstacle *obstacles; /* [obstacle_count] tissue to keep out of, borrowed; it moves; default none */
    int obstacle_count;
    sb_real clearance;            /* m from obstacles, > 0: half the needle's diameter, and margin; default 1/50 of the
                                   * distance */
    const ndl_push_place *places; /* [place_count], at most NDL_GUIDE_PLACES, borrowed; default none */
    int place_count;
    ndl_push_model model; /* needed with places */
    void *user;
    sb_real tolerance; /* m, > 0: within it the target is met and clearance kept; default 1/200 of the distance */
    int samples;       /* paths tried by chance, 1 to a million; default 200 */
    int climbs;        /* tries to better the best one by ever smaller changes, 0 to a million; default 100 */
    unsigned seed;     /* of chance */
    unsigned cookie;   /* set by ndl_default_guide_def */
} ndl_guide_def;

/* One push. */
typedef struct ndl_guide_phase {
    ndl_push_def push; /* for ndl_push_begin; its direction is the place's */
    sb_vec3 point;     /* m, at rest: the point of interest, which the push is to be told of where it is */
    int obstacle;      /* that is moved out of the way; -1: the target is moved onto the path */
    int place;         /* -1: nothing has to be done, or no place can do anything; `push` is then not to be begun */
    sb_vec3 force;     /* N that the model expects */
    sb_real depth;     /* m that the point has to go at rest */
    sb_real left;      /* m that all forces of the plan leave of it */
} ndl_guide_phase;

typedef struct ndl_guide {
    int reaches;              /* 1: the target is met, obstacles are cleared, to the tolerance, by the model */
    sb_vec3 entry, direction; /* m, unit: the needle's straight path, */
    sb_real length;           /* m, to where the target then is */
    sb_real clearance;        /* m: of obstacles to the path, all forces being there; SB_REAL_MAX without obstacles */
    sb_real cost;             /* N, sum of weight times force */
    int phase_count;          /* >= 1, the target's is last */
    ndl_guide_phase phases[NDL_GUIDE_PHASES];
} ndl_guide;

NDL_API ndl_guide_def ndl_default_guide_def(sb_vec3 target, sb_vec3 entry, sb_vec3 direction);

/* The path, among `samples` random ones (the straight one to the target first) and `climbs` changes of the best, whose
 * pushes cost least; paths that leave obstacles in the way or the target aside cost more than any that do not.
 * Displacements add up (linear tissue); a place pushes in one phase only. Points of interest beyond NDL_GUIDE_PHASES -
 * 1 are not pushed, but count. SB_OK with any outcome. Failures leave *guide untouched: SB_ERROR_ARGUMENT (field,
 * obstacle or place named), SB_ERROR_NOT_FINITE (also of the model). Some 0.1 ms for a path and phase with 8 places,
 * beside what the model takes, which is asked some 128 times for each of up to four tries of a path and each place in
 * use. Distances are looked at in 64 points of a path: an obstacle thinner than 1/64 of it may lie between two, and
 * `clearance` is too large by up to 1/32 of the path over 8 clearances. A distance that is no number is within an
 * obstacle. Deterministic to the bit, nothing is allocated. */
NDL_API sb_result ndl_guide_make(const ndl_guide_def *def, ndl_guide *guide, sb_error *error);

#endif /* NDL_GUIDE_H */

/* ==== src/needle/couple.h ==== */
/* couple: one linear system for tissue and rods that stick to it or slip through it. Floor 6, internal but for
 * ndl_contact. Chapters 7 and 8 of Chentanez 2010, in the null-space form. */
#ifndef NDL_COUPLE_H
#define NDL_COUPLE_H


/* How a node of a needle goes with the tissue. */
typedef enum ndl_contact {
    NDL_FREE = 0,            /* outside */
    NDL_STATIC = 1,          /* sticks: friction below its limit */
    NDL_DYNAMIC_FORWARD = 2, /* slips towards the tip (DYNAMIC+) */
    NDL_DYNAMIC_BACKWARD = 3 /* slips towards the base (DYNAMIC-) */
} ndl_contact;

/* How the friction states of a step were found. */
typedef struct ndl_couple_info {
    int trials;     /* linear systems with different friction states, >= 1; the most of a Newton iteration */
    int consistent; /* 1: every node that sticks is within its limit, every one that slips goes the way it was taken to;
                     * 0: the cap on trials was hit, and the last solution was taken */
    int iterations; /* of conjugate gradients, in all trials */
    int capped;     /* 1: their cap was hit */
    sb_real residual; /* sqrt(r.M^-1 r) relative to its start */
} ndl_couple_info;

#endif /* NDL_COUPLE_H */

/* ==== src/needle/needle.h ==== */
/* needle: flexible needles in soft tissue. A sleeve feeds, turns and moves a needle; its tip cuts, its shaft sticks and
 * slips, and the tissue's mesh follows. Floor 6. Chapters 7 to 10 of Chentanez 2010.
 *
 *     ndl_needle_def def = ndl_default_needle_def();
 *     def.body = body;
 *     def.base = sb_v3(0, 0, 0.1), def.direction = sb_v3(0, 0, -1);
 *     ndl_needle_create(&def, &needle, &error);
 *     command.insertion = 0.01;                                    (1 cm/s)
 *     ndl_step(body, &needle, 1, 0.02, &command, &info, &error); */
#ifndef NDL_NEEDLE_H
#define NDL_NEEDLE_H


enum { NDL_MAX_NEEDLES = 16 }; /* in one body */

typedef struct ndl_needle ndl_needle;

/* ---- what tissue does to a needle ---- */

/* What a region of tissue does to a needle, whatever presses on it (Tresca friction). All >= 0, default 0. */
typedef struct ndl_friction {
    sb_real friction; /* N/m along the shaft: while less is needed the needle sticks, when it slips it feels this. Of
                       * the order of 10 to 100 in soft tissue */
    sb_real viscous;  /* N s/m^2: more for slip at 1 m/s */
    sb_real cutting;  /* N at the tip while it goes forward; of the order of 1 */
    sb_real twist_stiffness; /* N m/rad per m of shaft: tissue that sticks holds against turning, */
    sb_real twist_friction;  /* up to this torque, N m per m of shaft. Both 0: the needle turns freely */
} ndl_friction;

/* A face between regions, as of a capsule, which must be punctured: the tip needs `strength` beside the cutting force
 * of the harder of its regions while it is within half of `thickness` of that face (in the undeformed tissue). A step
 * is divided where a tip comes into that or out of it, so that what a hand feels hardly depends on dt and speed: of 100
 * random needles at up to 40 degrees, 5 to 100 mm/s and dt 5 to 50 ms all peaks were within 10 % of strength, cutting
 * and friction. With NDL_REMESH the mesh may add to that (1 of 60: 7 N), and at a skin it does. */
typedef struct ndl_membrane {
    int regions[2];    /* on its two sides; -1: outside of the tissue (the skin) */
    sb_real strength;  /* N, >= 0 */
    sb_real thickness; /* m, > 0 */
} ndl_membrane;

/* Force (N, >= 0) to cut at the material point X (m) of a region, instead of the table's cutting and membranes. Not
 * negative, not NaN (taken for 0). Called once per step and needle in the tissue. */
typedef sb_real (*ndl_cutting)(void *user, sb_vec3 X, int region);

/* ---- creation ---- */

/* How a needle is in the tissue.
 *
 * Which to take: NDL_EMBED, the default, wherever forces, bends or places matter, in soft tissue above all, in other
 * elements than tet4, in cut bodies, for needles close together. NDL_REMESH (what Chentanez 2010 has) where nodes are
 * wanted on the needle's line, or steps have to be cheap: it takes 0.6 times the time in a gel phantom of 24 x 24 x 3
 * cells. Of 200 needles into random ellipsoids none felt 0.05 N more than friction and cutting in any step; of 5,240
 * into six organs, whose lowest sixth is held, 6 felt more than three times them and 0.2 N, by up to 3 N, unless their
 * tips were stopped (ndl_step_info.blocked). Nearly along the skin needles may tear out (ndl_step_info.torn): of 60
 * wires of 1.8 mm at 63 to 86 degrees from its normal, in 14 kPa, 6 did so, with NDL_EMBED none. Markers of that
 * phantom are off those of a finer mesh by 0.107 mm with NDL_REMESH, 0.022 with NDL_EMBED (RMS; needle_phantom);
 * lateral stiffness changes 1.9 times over edges from 17 to 7 mm with NDL_REMESH; in 50 kPa a bend is 0.82 to 1.56 of
 * its law with NDL_REMESH (ndl_step_info.coarse says when), 0.99 to 1.06 with NDL_EMBED. A nitinol needle 28 mm deep in
 * 30 kPa that is drawn back takes tissue with it by 422 N/m, as a line of its radius in a tube of 30 mm, and its tip by
 * some more: with edges of 12 and 7.5 mm NDL_EMBED has 484 and 436 N/m, NDL_REMESH 1050 and 920. So after 4 mm of the
 * way NDL_REMESH slips, and holds all of the friction (0.82 N), while NDL_EMBED still sticks, as a needle would (0.43
 * N); after 10 mm both hold friction times depth. Templates: 4 and 16 held needles 5 mm apart, in edges of 5 and 10 mm,
 * feel friction and cutting to 1 %.
 *
 * With NDL_EMBED the shaft is held by springs at material points. They are what the mesh does not show of the tissue
 * close to the needle (couple_rows.h), so that what a hand feels hardly depends on the mesh: an 18-gauge or nitinol
 * needle 45 mm deep in 12 to 240 kPa is within 6 % of the lateral stiffness of the needle as a solid in a mesh graded
 * to it, with edges from 20 to 5 mm (needle_study --all), 5 % above it in a mesh that is uneven and distorted, 4 to 8 %
 * below it in other elements than tet4. Shafts stay on what their tips cut, to 0.05 mm in stiff gel. Needles enter
 * where they meet the skin: of 200 into random ellipsoids none felt 0.02 N more than friction and cutting in any step.
 * Under load the rod is ahead of its material points, by 1 mm of 20 N/m and 3 mm at a tip of 0.5 N in 50 kPa, which is
 * how far tissue about a needle is drawn along. A tip bends as its bevel says: after 8 cm in 10 to 50 kPa it is aside
 * by the same to 3 % with edges from 20 to 7 mm (5 mm in 10 kPa: 7 % less). Limits: lips of a cut that touch let a
 * needle through, but it does not go in through open ones, and is stopped as by a wall where a piece stands apart from
 * the next; where tissue was burnt away (sb_cut_ablate) nothing holds it, through burnt skin and out of the far side as
 * well, but friction comes and goes there by whole edges of the rod, and a way that is a part of one may not be seen; a
 * loose piece may stay on it when it is drawn out; the sb_cut that cut the body has to stay as long as needles do:
 * without it they are out of the tissue, as where others change the mesh; entry_slip is not read.
 */
typedef enum ndl_follow {
    NDL_REMESH = 0, /* the mesh follows: nodes are moved and made on the needle's line. tet4, def.slack > 0, no cuts; no
                     * two needles in one element */
    NDL_EMBED = 1   /* the mesh stays as it is: any elements but SB_CUSTOM, cut or not, several needles in an element */
} ndl_follow;

/* What a needle is made from. Start from ndl_default_needle_def(), set body, base and direction. */
typedef struct ndl_needle_def {
    sb_body *body;     /* with implicit steps; borrowed, destroyed after its needles. Its material, supports, loads and
                        * integrator are its own: see ndl_step */
    ndl_follow follow; /* default NDL_EMBED; the same for all needles of a body, and of a body whose states hold them */
    sb_vec3 base;      /* m: the sleeve's outlet, outside of the tissue */
    sb_vec3 direction; /* in which the needle leaves it, any length but 0 */
    sb_vec3 director;  /* m1 of the base, projected; default 0: any. A bevel bends the needle towards m2 = t x m1 */
    sb_real length;    /* m out of the sleeve at the start, > 0; default 0.05. The needle must be outside of the tissue,
                        * and outside of where its skin was before holes were burnt in it */
    sb_real edge_length;     /* m between nodes outside of the tissue, > 0; default 0: the mean of the tissue's edges */
    int capacity;            /* most nodes of the rod, >= 8; default 128 */
    ndl_rod_section section; /* default NDL_STYLET_18G */
    const ndl_rod_stiffness *stiffness;       /* overrules the section; default NULL */
    sb_real damping_stretch, damping_bending; /* s, as of ndl_rod_def; default 1e-4 */
    sb_vec3 gravity;                          /* m/s^2, on the needle; default 0 */
    ndl_bevel bevel;                          /* default a symmetric tip (NDL_BEVEL_CURVATURE with curvature 0) */
    sb_real bend_length;                      /* m of a pre-bent tip, >= 0 and < length; default 0 */
    sb_real bend_curvature;                   /* 1/m of it at rest, towards m2 */
    const ndl_friction *frictions; /* [friction_count] by region, or one for all; default NULL: none. Copied */
    int friction_count;
    const ndl_membrane *membranes; /* [membrane_count] or NULL; copied */
    int membrane_count;
    ndl_cutting cutting; /* default NULL: by the tables */
    void *cutting_user;
    sb_real entry_slip; /* where the skin is not flat the entry may be put on a node or edge of it, this share of the
                         * face's longest edge away at most (see ndl_remesh_def). In [0, 0.25].
                         * Default 0.25; 0: the entry stays where the needle met the skin, with flatter tets about
                         * it. Either way the shaft stays where it is, and goes with the entry at that distance: of
                         * 200 needles in ellipsoids, with 0.3 N to cut, the most was 0.55 N with 0.25, 0.45 N with
                         * 0 */
    int max_trials;     /* linear systems per Newton iteration with different states of friction, >= 1; default 10. The
                         * largest of all needles' holds */
    sb_allocator allocator; /* default malloc */
    unsigned cookie;        /* set by ndl_default_needle_def; a def made without it is refused */
} ndl_needle_def;

NDL_API ndl_needle_def ndl_default_needle_def(void);

/* A needle at rest, at its body from then on. *needle is untouched on failure: SB_ERROR_ARGUMENT (field named; a tip
 * that begins in the tissue; a membrane between regions that do not meet), _NOT_FINITE, _MATERIAL (section),
 * _UNSUPPORTED (NDL_MAX_NEEDLES are there; what the body is made of, see def.body), _MEMORY.
 *
 * From then on it is part of the body's saved state, hash and recording. A state that was saved with needles, in
 * mid-insertion too, is loaded (sb_body_state_load) into a body that has needles of the same defs, made in the same
 * order, wherever they are: it goes on to the last bit. A recording holds ndl_step and ndl_needle_move_base, and is
 * played on such a body. Make needles before a recording is started, and destroy them after it has been stopped: what
 * follows otherwise is refused when it is played. A `cutting` of your own is not saved: both must do the same. */
NDL_API sb_result ndl_needle_create(const ndl_needle_def *def, ndl_needle **needle, sb_error *error);
/* Takes it out of the tissue first. NULL is fine. */
NDL_API void ndl_needle_destroy(ndl_needle *needle);

/* ---- motion ---- */

/* What a needle is to do in a step; zeros: nothing. */
typedef struct ndl_command {
    sb_real insertion;        /* m/s fed out of the sleeve; negative: drawn back */
    sb_real twist;            /* rad/s of the base about its axis */
    sb_vec3 velocity;         /* m/s of the sleeve's outlet */
    sb_vec3 angular_velocity; /* rad/s of the sleeve about its outlet; its part along the axis adds to twist */
} ndl_command;

/* In the next step the sleeve goes to `base` (m), looks along `direction` and turns its m1 into `director` (any length
 * but 0; the short way), beside what the command says: for sleeves that are tracked. director 0: turned only as the
 * direction turns. SB_ERROR_ARGUMENT, _NOT_FINITE change nothing. */
NDL_API sb_result ndl_needle_move_base(ndl_needle *needle, sb_vec3 base, sb_vec3 direction, sb_vec3 director);

/* What a step did, over all needles and substeps. */
typedef struct ndl_step_info {
    int substeps;      /* a step is cut where a tip would go further than about half an edge of the tissue, where it
                        * comes into a membrane or out of it, and where no solution was found: into a fourth, a 16th,
                        * a 64th of that, and longer ones again behind it */
    sb_real peak_base; /* N, largest force on a base at the end of a substep: what a membrane asked for that gave way
                        * within the step */
    int trials;        /* largest number of a substep */
    int consistent;    /* 1: friction states came out as they were taken, in all substeps; 0: in one they were not found
                        * in max_trials, but what is held is within 2 % of what friction and tips can hold */
    int iterations;    /* of conjugate gradients, in all */
    int capped;        /* 1: their cap was hit */
    sb_real residual;  /* largest of a substep */
    int static_nodes, dynamic_nodes; /* at the end */
    int operations;                  /* of the remesher */
    sb_real worst_quality;           /* of tets about the tips; 1: none */
    int blocked;         /* needles whose tip is held: it has come near the skin from inside, or the mesh could not
                          * follow it (no operation left sound tets, no memory); then it tries again later */
    int torn;            /* needles that tore out of the skin, because nothing else could be computed: less than half an
                          * edge deep, or, with NDL_REMESH, where the mesh has left the shaft so far beside its path
                          * that no step, however short, goes on from there. With NDL_EMBED they are held again,
                          * without a force at first, once they are half an edge deep: from where the shaft goes in
                          * through the skin. With NDL_REMESH they come in again when their tips cross the skin anew,
                          * from outside */
    int limited;         /* needles that were fed less than asked for: the sleeve holds the rest, or capacity is used */
    int coarse;          /* needles with NDL_REMESH in tissue so soft that it, not the bevel, sets how far they bend
                          * (curvature times lam beyond the lag, see steer.h): their way then depends on the mesh, 0.82
                          * to 1.56 times the bend of NDL_EMBED. Do not trust it; take NDL_EMBED */
    sb_step_info body;   /* of the last substep */
    double seconds_body; /* with the body's clock, else 0: forces, matrix and preconditioner of the body, */
    double seconds_couple; /* needles' matrices and all trials, */
    double seconds_needle; /* sleeves, frames and nodes of the needles, */
    double seconds_remesh; /* remeshing with its changes of the matrix, */
    double seconds_total;  /* and the whole call */
} ndl_step_info;

/* Advances a body and all its needles by dt (s, > 0): in place of sb_body_step, which moves the body without them.
 * needles: [count], each needle of the body once, in any order; commands: [count] beside them, or NULL: zeros
 * info may be NULL. On failure all is as before: SB_ERROR_ARGUMENT (needle missing or doubled; a command that would
 * take over 1000 substeps), _NOT_FINITE (command named); SB_ERROR_UNSUPPORTED, a needle is at a node that constraints
 * eliminate; with NDL_REMESH, two needles would share an element (which are, is said), or the body is cut
 * (sb_cut_triangles);
 * SB_ERROR_DIVERGED (node named); SB_ERROR_INVERTED (element named); SB_ERROR_MEMORY; SB_ERROR_STATE, another change of
 * the body is open. Where the mesh has changed within a step that fails and there is no memory to take that back
 * either, SB_ERROR_MEMORY says so: body and needles are then between two states until the next call of ndl_step or
 * ndl_needle_create, which takes the step back first, or until a saved state is loaded. Steps that do without memory
 * they asked for (info->blocked) are not repeated by a recording that has it.
 *
 * A step is divided where a tip comes to an edge of a membrane, and would go past it by more than a quarter of the
 * membrane's thickness, or a command is fast, and where it fails as a whole: the rod would fold, tissue would turn
 * inside out, or of hyperelastic tissue max_newton iterations do not bring it to where the needle has gone (what is
 * read of a needle is never the force of that gap). Supports and tools of an sb_contact go evenly over its parts, and
 * what tools feel, as a blade's forces, is of the step that was made, whatever was tried before. In parts cut short by
 * a membrane a tool that just comes to the tissue feels the parts' shorter time: up to 8 % of the force that it has
 * later (measured in 8 scenes).
 *
 * The linear systems of the body's own step are solved together with needles and friction (see couple.h), to its
 * tolerance: one where it is linearised (max_newton 1), otherwise until body, needles and friction balance. Needles are
 * stepped by implicit Euler, the body by its own integrator. SB_EULER and SB_GENERALISED_ALPHA with spectral_radius 0,
 * which is of second order, let the force on the base settle at once when the needle stops; others do not damp the
 * motion that friction leaves in the tissue. Measured (nitinol needle 3.5 cm deep in 50 kPa, push 1.20 N, steps of 20
 * ms): half a second after the stop the force stays within 1e-4 N with the two; with SB_NEWMARK it goes on ringing by 5
 * mN, without damping_stiffness by 0.34 N; with spectral_radius 0.8 it jumps by up to 0.45 N from step to step while
 * the needle moves (0.007 N with 0).
 *
 * Steps of a millisecond, as hands ask for, take some 0.6 of the time with NDL_EMBED in a body of tet4 that keeps its
 * tangent (sb_body_keep_tangent), and the force on the base stays the same to a millionth. */
NDL_API sb_result ndl_step(sb_body *body, ndl_needle *const *needles, int count, sb_real dt,
                           const ndl_command *commands, ndl_step_info *info, sb_error *error);

/* ---- readings: no allocation ---- */

/* The rod: positions, frames, curvature; nodes 0 and 1 are in the sleeve, node 1 at its outlet. Valid until the needle
 * is destroyed, its arrays until the next step. */
NDL_API const ndl_rod *ndl_needle_rod(const ndl_needle *needle);
/* Where the tip is and looks, for ndl_steer_update; it bends towards frame.m2. With NDL_BEVEL_CURVATURE t is where the
 * path goes on; the rod's last edge, a chord, lags behind by half of what it bends, and more after a turn. */
NDL_API ndl_tip_pose ndl_needle_tip(const ndl_needle *needle);
/* What the sleeve exerts on the needle at its outlet: force (N) and torque (N m) about it, in the last step. What a
 * hand feels is the opposite. Either may be NULL. */
NDL_API void ndl_needle_base_wrench(const ndl_needle *needle, sb_vec3 *force, sb_vec3 *torque);
/* First node of the rod in the tissue; the rod's node_count when it is outside. With NDL_EMBED the edge before it goes
 * in through the skin, and is held there, too: that node has a contact state and force. */
NDL_API int ndl_needle_entry(const ndl_needle *needle);
/* Tissue node that a rod node is at; -1: none, as with NDL_EMBED. */
NDL_API int ndl_needle_body_node(const ndl_needle *needle, int node);
/* What follows the tips of all needles of its body, for readings: ndl_remesh_quality, _is_original, _nodes ...; gone
 * with the body's last needle. NULL with NDL_EMBED. */
NDL_API const ndl_remesh *ndl_needle_remesh(const ndl_needle *needle);
NDL_API ndl_contact ndl_needle_contact(const ndl_needle *needle, int node);
/* Force (N) of the tissue on a node in the last step. */
NDL_API sb_vec3 ndl_needle_contact_force(const ndl_needle *needle, int node);
/* Length of shaft in the tissue, in holes that were burnt in it, and out of one on its far side (m), and fed since
 * creation. */
NDL_API sb_real ndl_needle_depth(const ndl_needle *needle);
NDL_API sb_real ndl_needle_fed(const ndl_needle *needle);
/* How far the tip went through the tissue in the last step (m, along the tip; negative: back). */
NDL_API sb_real ndl_needle_advance(const ndl_needle *needle);
/* Force (N) that would let the tip go forward now; SB_REAL_MAX while it is held. */
NDL_API sb_real ndl_needle_cutting(const ndl_needle *needle);
/* Material point (m) of the tip; 0 when the needle is outside, else 1. */
NDL_API int ndl_needle_tip_material(const ndl_needle *needle, sb_vec3 *X);

#endif /* NDL_NEEDLE_H */

/* ==== src/needle/rod_state.h ==== */
/* rod_state: saves what a rod is at, and brings it back to the last bit. Floor 6. */
#ifndef NDL_ROD_STATE_H
#define NDL_ROD_STATE_H


/* For rods that are stepped by themselves: a needle's is part of its body's state (sb_body_state_save).
 *
 * A saved rod holds all that steps, setters and splits change. What follows a load is what followed the save, bit for
 * bit, also in another process or machine with the same order of bytes. It is loaded into a rod that was made from the
 * same def, in the same precision; capacity and allocator may differ.
 *
 * size: bytes that save writes for the rod as it is. save: size must be at least that, what is behind stays; nothing
 * that a step could notice changes, nothing is allocated. load: size may be larger than what was saved; allocates
 * nothing. Buffers need no alignment.
 *
 * Failures leave everything as it was (and `error` may be NULL): SB_ERROR_ARGUMENT (NULL, or too small a buffer);
 * SB_ERROR_FORMAT (no saved rod, cut short, damaged, a count out of its range); SB_ERROR_UNSUPPORTED (other version,
 * precision or order of bytes); SB_ERROR_STATE (another def's, or more nodes than there is room for);
 * SB_ERROR_NOT_FINITE. */
NDL_API size_t ndl_rod_state_size(const ndl_rod *rod);
NDL_API sb_result ndl_rod_save(const ndl_rod *rod, void *buffer, size_t size, sb_error *error);
NDL_API sb_result ndl_rod_load(ndl_rod *rod, const void *buffer, size_t size, sb_error *error);


#endif /* NDL_ROD_STATE_H */

#endif /* NEEDLE_H */

#if defined(NDL_IMPLEMENTATION) && !defined(NDL_IMPLEMENTATION_DONE)
#define NDL_IMPLEMENTATION_DONE

/* ==== src/needle/topology.h, internal ==== */
struct ndli_image;

/* What a node is; flags of ndli_topology.node_flags. */
enum {
    NDLI_NODE_ALIVE = 1,     /* the slot holds a node */
    NDLI_NODE_BOUNDARY = 2,  /* on the body's surface */
    NDLI_NODE_INTERFACE = 4, /* between regions */
    NDLI_NODE_FIXED = 8,     /* supported: stays where it is in the material */
    NDLI_NODE_CREATED = 16,  /* made by a split: has no place of its own in the undivided mesh */
    NDLI_NODE_NEEDLE = 32    /* on a needle now */
};

/* A node that a change made or moved: the old fields at four old nodes, times the weights, give its new ones. */
typedef struct ndli_node_change {
    int node;
    int created; /* 1: a new node (its slot may have held another); 0: moved */
    int sources[4];
    sb_real weights[4];
    sb_vec3 X; /* its material position (m) */
} ndli_node_change;

/* A slot of a node that came into use, or (~node) went out of it, and what was known of the node before. */
typedef struct ndli_node_event {
    int node, owner;
    unsigned char flags;
    sb_vec3 X0;
} ndli_node_event;

/* What one change did, in the order in which it was done: slots are given and taken in that order. Valid until the next
 * change. */
typedef struct ndli_topology_change {
    const ndli_node_event *node_events;
    const int *tet_events; /* a slot that came into use, or ~slot of one that went */
    int node_event_count, tet_event_count;
    const int *changed; /* tets that stay in their slots with other nodes or, where a node moved, another shape */
    int changed_count;
    const ndli_node_change *nodes; /* in the order of the nodes that came, moved ones between them */
    int node_count;
} ndli_topology_change;

/* Arrays are for reading, but for the flag of fixed nodes. All lie in one block with slack; it grows by half when a
 * change needs more, which moves them. Slots of removed nodes and tets are used again, last removed first.
 *
 * The tets of a node are a ring of corners: corner 4 t + c is node c of tet t.
 *
 *     for (int k = mesh->node_star[node]; k >= 0; k = mesh->corner_next[k])
 *         visit(k / 4);
 */
typedef struct ndli_topology {
    int node_count, tet_count; /* in use */
    int node_end, tet_end;     /* one past the last slot ever used: loops run to here, and skip some */
    int node_capacity, tet_capacity;
    int original_nodes, original_tets; /* of the mesh it was made from: slots below these */

    /* nodes [node_end] */
    sb_vec3 *X;                /* material position (m) */
    sb_vec3 *X0;               /* material position in the undivided mesh; created nodes: where they were made */
    const sb_vec3 *x;          /* position (m): the body's, borrowed anew after each change and before each step */
    int *owner;                /* needle that the node is on or was made by, or -1 */
    int *node_star;            /* first corner, or -1 */
    unsigned char *node_flags; /* NDLI_NODE_...; 0: not in use */

    /* tets [tet_end] */
    int *tets;        /* [4] nodes, positively oriented in the material; tets[4 t] < 0: not in use */
    int *neighbours;  /* [4] tet across the face opposite node c, or -1 */
    int *corner_next; /* [4] */
    int *corner_prev; /* [4] */
    int *regions;
    int *parents;       /* tet that it was cut from last, for a tet made by a change; else itself */
    sb_real *volumes;   /* in the material (m^3) */
    sb_real *qualities; /* 6 sqrt(2) V / l_rms^3: 1 for the regular tet, <= 0 flat or inverted */

    sb_allocator allocator;

    /* free slots, displaced nodes and the change under way */
    int free_node, free_tet;
    int *displaced, *displaced_at, displaced_count;
    int *node_index; /* a remesher's scratch, zeros between its calls */
    unsigned char *tet_mark, *node_mark;
    int *touched, touched_count, *affected, affected_count;
    int *displaced_before, displaced_before_count; /* at the begin of the change */
    ndli_node_event *node_events;                  /* [2 node_capacity] */
    int node_event_count;
    int *tet_events, tet_event_count; /* [2 tet_capacity] */
    int *changed;                     /* [tet_capacity] */
    ndli_node_change *changes;
    int change_count;
    void *block;
} ndli_topology;

/* Becomes the body's mesh, with nothing known of needles: all nodes are at their own places. Its allocator must be set.
 * 0: no memory, nothing changed. O(nodes + tets). */
NDLI_API int ndli_topology_read(ndli_topology *mesh, const sb_body *body);
/* The same where the body's mesh is one that it has known: keeps X0, owners and flags; there is room. */
NDLI_API void ndli_topology_read_again(ndli_topology *mesh, const sb_body *body);
/* To be called once the body has moved: borrows its positions, and sees which nodes are supported. */
NDLI_API void ndli_topology_look(ndli_topology *mesh, const sb_body *body);
/* Safe on {0} and on NULL. */
NDLI_API void ndli_topology_free(ndli_topology *mesh);

/* Tet that holds a point: a walk from `start` (any tet in use) through the faces the point lies behind, in the material
 * (positions = mesh->X) or in space (the body's). Returns the tet and its barycentric weights, all >= 0 but for
 * rounding; or -1 when the walk ends at the surface: then *weights are of the last tet, stretched beyond it. weights:
 * [4], may be NULL. -1 also for a start that is no tet, without weights. */
NDLI_API int ndli_topology_find(const ndli_topology *mesh, const sb_vec3 *positions, sb_vec3 point, int start,
                                sb_real weights[4]);
/* Tet that holds a point in space, or -1. A walk may end at tets that are inverted: skin that is pushed in before it
 * breaks folds the tissue below it. Then all are looked at, and of those that hold the point the one counts that has
 * kept its shape best. O(tets) there, and for points outside. */
NDLI_API int ndli_topology_find_in_space(const ndli_topology *mesh, sb_vec3 x, int start);
/* Deformation gradient in a tet. */
NDLI_API sb_mat3 ndli_topology_gradient(const ndli_topology *mesh, int tet);
/* First surface face that the segment crosses from outside in space; 0 and *hit untouched when
 * there is none. O(tets): for a needle that is not in yet. */
NDLI_API int ndli_topology_hit(const ndli_topology *mesh, sb_vec3 from, sb_vec3 to, ndl_surface_hit *hit);

/* How good the material mesh is; any place may be NULL. Angles in degrees. O(tets). */
NDLI_API void ndli_topology_quality(const ndli_topology *mesh, sb_real *worst_quality, sb_real *min_dihedral,
                                    sb_real *max_dihedral);
/* Whether every index, ring, neighbour and mark is consistent. SB_ERROR_MESH names the first fault. */
NDLI_API sb_result ndli_topology_check(const ndli_topology *mesh, sb_error *error);
/* 1 when all nodes, tets and positions are those of the mesh it was made from, number by number. */
NDLI_API int ndli_topology_is_original(const ndli_topology *mesh);

/* Quality of a tet by its corners. Inline: thousands of them decide one operation. */
SB_INLINE sb_real ndli_tet_quality(sb_vec3 a, sb_vec3 b, sb_vec3 c, sb_vec3 d)
{
    sb_vec3 ab = sb_v3_sub(b, a), ac = sb_v3_sub(c, a), ad = sb_v3_sub(d, a);
    sb_vec3 bc = sb_v3_sub(c, b), bd = sb_v3_sub(d, b), cd = sb_v3_sub(d, c);
    sb_real det = sb_v3_dot(ab, sb_v3_cross(ac, ad));
    sb_real mean = (sb_v3_dot(ab, ab) + sb_v3_dot(ac, ac) + sb_v3_dot(ad, ad) + sb_v3_dot(bc, bc) + sb_v3_dot(bd, bd) +
                    sb_v3_dot(cd, cd)) /
                   6;
    return mean > 0 ? (sb_real)1.4142135623730951 * det / (mean * sb_sqrt(mean)) : 0;
}
NDLI_API void ndli_tet_weights(sb_vec3 a, sb_vec3 b, sb_vec3 c, sb_vec3 d, sb_vec3 p, sb_real weights[4]);
/* Tet of a point that lies in the material, by a walk from `start`, and its weights, all >= 0. Just outside by
 * rounding: the best tet about the start, its weights cut off. */
NDLI_API int ndli_topology_source(const ndli_topology *mesh, sb_vec3 X, int start, sb_real weights[4]);
/* 0 when memory for so many more nodes and tets is short: then nothing has changed. */
NDLI_API int ndli_topology_reserve(ndli_topology *mesh, int nodes, int tets);

/* A change: begin; plan every node to be made or moved, while the old mesh still stands; cut, mend, move; end. What it
 * needs must have been reserved: none of this can fail. */
NDLI_API void ndli_topology_begin(ndli_topology *mesh);
/* node -1: to be made. Returns the number of the plan. */
NDLI_API int ndli_topology_plan(ndli_topology *mesh, int node, sb_vec3 X, int start);
/* Replaces every tet that holds the simplex by `size` ones with the planned node in place of one corner each. groups
 * receives the tets' slots, `size` per tet cut. Returns the number of tets cut. */
NDLI_API int ndli_topology_cut(ndli_topology *mesh, const int *simplex, int size, int plan, int *groups);
/* The way back: takes the node out. */
NDLI_API void ndli_topology_mend(ndli_topology *mesh, int node, const int *simplex, int size, const int *groups,
                                 int count);
NDLI_API void ndli_topology_move(ndli_topology *mesh, int plan);
NDLI_API void ndli_topology_end(ndli_topology *mesh, ndli_topology_change *change);
/* After the end: the body has refused the change, and all is as it was at the begin. O(nodes + tets). */
NDLI_API void ndli_topology_take_back(ndli_topology *mesh, const sb_body *body);

/* What the body's mesh does not say, for undo and saved states: measures, writes or reads. counts: NDLI_TOPOLOGY_COUNTS
 * ints that ndli_topology_counts gives; when reading, the image's. */
enum { NDLI_TOPOLOGY_COUNTS = 4 };
NDLI_API void ndli_topology_counts(const ndli_topology *mesh, int *counts);
NDLI_API void ndli_topology_walk(ndli_topology *mesh, const int *counts, struct ndli_image *image);
/* After reading, and once the body has the mesh that goes with it. */
NDLI_API void ndli_topology_recall(ndli_topology *mesh, const int *counts, const sb_body *body);
/* Whether what ndli_topology_walk wrote to `in` for these counts (counts[0] <= node_end, counts[1] <= counts[0]) goes
 * with this mesh; owners below max_owner. SB_ERROR_FORMAT, SB_ERROR_NOT_FINITE. */
NDLI_API sb_result ndli_topology_check_memory(const ndli_topology *mesh, const int *counts, const unsigned char *in,
                                              int max_owner, sb_error *error);
/* The tet with the lowest slot that has both nodes, or -1. */
NDLI_API int ndli_topology_first_tet(const ndli_topology *mesh, int i, int j);

/* ==== src/needle/remesh.h, internal ==== */
#define NDLI_ENTRY_SLIP ((sb_real)0.25) /* the defaults of entry_slip */
/* What the remesher knows of the mesh; it stays where it is. */
NDLI_API const ndli_topology *ndli_remesh_topology(const ndl_remesh *remesh);
/* To be called before positions are read through it, once the body has moved; supports that are new are seen, too.
 * Where the body has got another mesh that is read, and no needle is in it: SB_ERROR_MEMORY. */
NDLI_API sb_result ndli_remesh_look(ndl_remesh *remesh, sb_error *error);
/* 1: the body has got another mesh since. */
NDLI_API int ndli_remesh_is_stale(const ndl_remesh *remesh);
/* 1: what changes the body's mesh until it is 0 again is the remesher's own. */
NDLI_API void ndli_remesh_set_own(ndl_remesh *remesh, int own);
/* Withdraws the needle, and where the body refuses that leaves its splits in the mesh. */
NDLI_API void ndli_remesh_let_go(ndl_remesh *remesh, int needle);
/* ndl_remesh_puncture with another entry_slip than the remesher's. */
NDLI_API sb_result ndli_remesh_puncture_within(ndl_remesh *remesh, int needle, const ndl_surface_hit *hit, sb_real slip,
                                               ndl_remesh_info *info, sb_error *error);
/* Takes a tip that is at its entry to X in one operation, however far that is. SB_ERROR_MESH, with nothing changed,
 * also when tets about it would be worse than `enough` and than they are. */
NDLI_API sb_result ndli_remesh_put_first(ndl_remesh *remesh, int needle, sb_vec3 X, sb_real enough,
                                         ndl_remesh_info *info);

/* ---- remesh_state.c ----
 * Undo: into memory of at least the snapshot's size, and back into the remesher it is from, once the body is back. */
NDLI_API size_t ndli_remesh_snapshot_size(const ndl_remesh *remesh);
NDLI_API size_t
ndli_remesh_snapshot_room(const ndl_remesh *remesh); /* most, while the needles keep to what was reserved */
NDLI_API void ndli_remesh_snapshot(const ndl_remesh *remesh, void *buffer);
NDLI_API void ndli_remesh_rewind(ndl_remesh *remesh, const void *buffer);
/* Between the check of a saved state and its load or refusal: the nodes that the needle has in it, as of
 * ndl_remesh_nodes. */
NDLI_API const int *ndli_remesh_staged_nodes(const ndl_remesh *remesh, int needle, int *count);

/* ==== src/needle/rod_state.h, internal ==== */
struct sbi_state_out;

/* ---- internal: for undo and for the state of a body ----
 * The same without checks; restoring cannot fail. */
NDLI_API size_t ndli_rod_snapshot_size(const ndl_rod *rod, int node_count); /* when it has so many nodes */
NDLI_API void ndli_rod_snapshot(const ndl_rod *rod, void *buffer);
NDLI_API void ndli_rod_rewind(ndl_rod *rod, const void *buffer);
/* The snapshot as part of a state. */
NDLI_API void ndli_rod_put(const ndl_rod *rod, struct sbi_state_out *out);
/* Whether in[size] begins with a snapshot that the rod may rewind to; used, nodes: its bytes and nodes. */
NDLI_API sb_result ndli_rod_check(const ndl_rod *rod, const unsigned char *in, size_t size, size_t *used, int *nodes,
                                  sb_error *error);

/* ==== src/needle/real3.h ==== */
/* real3: 3-vectors and 3x3 matrices of double, for rods. Floor 6, internal. A rod is a million times stiffer along
 * itself than across: float holds neither its strains nor its matrices, so rods are computed in double in float
 * builds, too. */
#ifndef NDL_REAL3_H
#define NDL_REAL3_H


typedef struct ndli_v3 {
    double x, y, z;
} ndli_v3;

/* m[row][column] */
typedef struct ndli_m3 {
    double m[3][3];
} ndli_m3;

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
SB_INLINE ndli_v3 ndli_v(double x, double y, double z)
{
    ndli_v3 v;
    v.x = x;
    v.y = y;
    v.z = z;
    return v;
}
SB_INLINE ndli_v3 ndli_from(sb_vec3 a) { return ndli_v((double)a.x, (double)a.y, (double)a.z); }
SB_INLINE sb_vec3 ndli_to(ndli_v3 a) { return sb_v3((sb_real)a.x, (sb_real)a.y, (sb_real)a.z); }
SB_INLINE ndli_v3 ndli_add(ndli_v3 a, ndli_v3 b) { return ndli_v(a.x + b.x, a.y + b.y, a.z + b.z); }
SB_INLINE ndli_v3 ndli_sub(ndli_v3 a, ndli_v3 b) { return ndli_v(a.x - b.x, a.y - b.y, a.z - b.z); }
SB_INLINE ndli_v3 ndli_scale(double s, ndli_v3 a) { return ndli_v(s * a.x, s * a.y, s * a.z); }
/* a + s b */
SB_INLINE ndli_v3 ndli_madd(ndli_v3 a, double s, ndli_v3 b)
{
    return ndli_v(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z);
}
SB_INLINE double ndli_dot(ndli_v3 a, ndli_v3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
SB_INLINE ndli_v3 ndli_cross(ndli_v3 a, ndli_v3 b)
{
    return ndli_v(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}
SB_INLINE double ndli_norm(ndli_v3 a) { return sqrt(ndli_dot(a, a)); }
SB_INLINE double ndli_component(ndli_v3 a, int i) { return i == 0 ? a.x : i == 1 ? a.y : a.z; }
SB_INLINE int ndli_is_finite(double x) { return x - x == 0; }

SB_INLINE ndli_m3 ndli_m_zero(void)
{
    ndli_m3 a;
    memset(&a, 0, sizeof a);
    return a;
}
/* *a += s b */
SB_INLINE void ndli_m_add(ndli_m3 *a, double s, const ndli_m3 *b)
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            a->m[i][j] += s * b->m[i][j];
}
/* *a += s I */
SB_INLINE void ndli_m_add_identity(ndli_m3 *a, double s)
{
    for (int i = 0; i < 3; i++)
        a->m[i][i] += s;
}
/* *a += s u v^T */
SB_INLINE void ndli_m_add_outer(ndli_m3 *a, double s, ndli_v3 u, ndli_v3 v)
{
    ndli_v3 row[3];
    row[0] = ndli_scale(s * u.x, v);
    row[1] = ndli_scale(s * u.y, v);
    row[2] = ndli_scale(s * u.z, v);
    for (int i = 0; i < 3; i++) {
        a->m[i][0] += row[i].x;
        a->m[i][1] += row[i].y;
        a->m[i][2] += row[i].z;
    }
}
/* *a += s [u], with [u] w = u x w */
SB_INLINE void ndli_m_add_cross(ndli_m3 *a, double s, ndli_v3 u)
{
    a->m[0][1] -= s * u.z;
    a->m[0][2] += s * u.y;
    a->m[1][0] += s * u.z;
    a->m[1][2] -= s * u.x;
    a->m[2][0] -= s * u.y;
    a->m[2][1] += s * u.x;
}
SB_INLINE ndli_m3 ndli_m_transpose(const ndli_m3 *a)
{
    ndli_m3 r;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            r.m[i][j] = a->m[j][i];
    return r;
}
SB_INLINE ndli_m3 ndli_m_mul(const ndli_m3 *a, const ndli_m3 *b)
{
    ndli_m3 r;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            r.m[i][j] = a->m[i][0] * b->m[0][j] + a->m[i][1] * b->m[1][j] + a->m[i][2] * b->m[2][j];
    return r;
}
/* a^T b */
SB_INLINE ndli_m3 ndli_m_tmul(const ndli_m3 *a, const ndli_m3 *b)
{
    ndli_m3 r;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            r.m[i][j] = a->m[0][i] * b->m[0][j] + a->m[1][i] * b->m[1][j] + a->m[2][i] * b->m[2][j];
    return r;
}
SB_INLINE ndli_v3 ndli_m_apply(const ndli_m3 *a, ndli_v3 v)
{
    return ndli_v(a->m[0][0] * v.x + a->m[0][1] * v.y + a->m[0][2] * v.z,
                  a->m[1][0] * v.x + a->m[1][1] * v.y + a->m[1][2] * v.z,
                  a->m[2][0] * v.x + a->m[2][1] * v.y + a->m[2][2] * v.z);
}
/* a^T v */
SB_INLINE ndli_v3 ndli_m_tapply(const ndli_m3 *a, ndli_v3 v)
{
    return ndli_v(a->m[0][0] * v.x + a->m[1][0] * v.y + a->m[2][0] * v.z,
                  a->m[0][1] * v.x + a->m[1][1] * v.y + a->m[2][1] * v.z,
                  a->m[0][2] * v.x + a->m[1][2] * v.y + a->m[2][2] * v.z);
}
#endif

#endif /* NDL_REAL3_H */

/* ==== src/needle/band.h ==== */
/* band: symmetric positive definite systems of small bandwidth, as chains of nodes make them. Floor 6, internal. */
#ifndef NDL_BAND_H
#define NDL_BAND_H


/* A symmetric n x n matrix whose entry (i, j) is 0 for |i - j| > width, by rows of its lower half: (i, j), i - width <=
 * j <= i, at a[i * (width + 1) + j - i + width]. The places before column 0 are never read. */
#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* A = L D L^T in place (L unit lower, 1/D on the diagonal). Returns -1, or the first row whose pivot is not above
 * `least` times its diagonal entry: the matrix is then not safely positive definite, and *a is spoilt. No allocation,
 * n width^2 / 2 multiply-adds. */
NDLI_API int ndli_band_factor(double *a, int n, int width, double least);
/* b = A^-1 b for a factored A. */
NDLI_API void ndli_band_solve(const double *a, int n, int width, double *b);
#endif

#endif /* NDL_BAND_H */

/* ==== src/needle/image.h ==== */
/* image: bytes of a saved state. Floor 6, internal.
 *
 * One function per object names its parts in order, whatever for: measuring, writing and reading are the same walk. */
#ifndef NDL_IMAGE_H
#define NDL_IMAGE_H


#include <string.h>

enum { NDLI_IMAGE_VERSION = 1, NDLI_IMAGE_ORDER = 0x01020304 };

/* None of the three: measures. */
typedef struct ndli_image {
    unsigned char *out;
    const unsigned char *in;
    sbi_state_out *state; /* of a body that the object is a part of */
    size_t used;
    int overflow;
} ndli_image;

/* What a part of so many bytes takes: parts begin at multiples of eight. */
SB_INLINE size_t ndli_image_room(size_t bytes) { return (bytes + 7) / 8 * 8; }

/* Returns where the part begins. */
SB_INLINE size_t ndli_image_part(ndli_image *image, void *array, size_t count, size_t size)
{
    size_t at = image->used, bytes = count * size, room;
    if (size && count > ((size_t)-1 - 16 - at) / size) {
        image->overflow = 1;
        return at;
    }
    room = ndli_image_room(bytes);
    if (image->state) {
        static const unsigned char zeros[8] = {0};
        sbi_state_put(image->state, array, bytes);
        sbi_state_put(image->state, zeros, room - bytes);
    }
    if (image->in && bytes)
        memcpy(array, image->in + at, bytes);
    if (image->out) {
        if (bytes)
            memcpy(image->out + at, array, bytes);
        memset(image->out + at + bytes, 0, room - bytes);
    }
    image->used = at + room;
    return at;
}

/* Number i of an array of ints in bytes of any alignment. */
SB_INLINE int ndli_image_int(const unsigned char *array, size_t i)
{
    int value;
    memcpy(&value, array + i * sizeof(int), sizeof value);
    return value;
}

SB_INLINE double ndli_image_real(const unsigned char *array, size_t i)
{
    double value;
    memcpy(&value, array + i * sizeof value, sizeof value);
    return value;
}

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* The checks that all loads begin with: kind, version, precision, size, checksum. Bytes behind the image do no harm.
 * magic: 8 bytes. */
NDLI_API sb_result ndli_image_check(const void *buffer, size_t size, const char *magic, const char *what,
                                    sb_error *error);
/* Hash of bytes whose number is a multiple of eight, or which are ints. */
NDLI_API uint64_t ndli_image_hash(uint64_t hash, const void *bytes, size_t size);
/* 1 when none of the numbers is NaN or infinite. */
NDLI_API int ndli_image_is_finite(const unsigned char *reals, size_t count);
#endif

#endif /* NDL_IMAGE_H */

/* ==== src/needle/image.c ==== */
/* image: what loads check before anything else. */

NDLI_API sb_result ndli_image_check(const void *buffer, size_t size, const char *magic, const char *what,
                                    sb_error *error)
{
    const unsigned char *image = (const unsigned char *)buffer;
    uint64_t written;
    if (!buffer)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "buffer is NULL");
    if (size >= SBI_IMAGE_HEAD + SBI_IMAGE_TAIL) {
        written = sbi_get_bytes(image + 16, 8);
        if (written >= SBI_IMAGE_HEAD + SBI_IMAGE_TAIL && written < (uint64_t)size)
            size = (size_t)written;
    }
    return sbi_image_check(image, size, magic, NDLI_IMAGE_VERSION, what, error);
}

NDLI_API uint64_t ndli_image_hash(uint64_t hash, const void *bytes, size_t size)
{
    const unsigned char *at = (const unsigned char *)bytes;
    for (; size >= 8; at += 8, size -= 8) {
        uint64_t word;
        memcpy(&word, at, 8);
        hash = sbi_hash_word(hash, word);
    }
    return size ? sbi_hash_word(hash, sbi_get_bytes(at, (int)size)) : hash;
}

NDLI_API int ndli_image_is_finite(const unsigned char *reals, size_t count)
{
    int good = 1;
    for (size_t i = 0; i < count; i++) {
        sb_real value;
        memcpy(&value, reals + i * sizeof value, sizeof value);
        good &= sb_is_finite(value);
    }
    return good;
}

/* ==== src/needle/band.c ==== */
/* band: see band.h. */


/* Row i holds L_ik D_k while it is being made, so that one product a term is enough; then it is scaled to L. */
NDLI_API int ndli_band_factor(double *a, int n, int width, double least)
{
    for (int i = 0; i < n; i++) {
        double *row = a + (size_t)i * (size_t)(width + 1) + width - i, diagonal = row[i], pivot = diagonal;
        int first = sbi_max_int(0, i - width);
        for (int j = first; j < i; j++) {
            const double *other = a + (size_t)j * (size_t)(width + 1) + width - j;
            double sum = row[j];
            for (int k = sbi_max_int(first, j - width); k < j; k++)
                sum -= row[k] * other[k];
            row[j] = sum;
        }
        for (int j = first; j < i; j++) {
            double scaled = row[j] * a[(size_t)j * (size_t)(width + 1) + (size_t)width];
            pivot -= row[j] * scaled;
            row[j] = scaled;
        }
        if (!(pivot > least * diagonal) || !ndli_is_finite(pivot))
            return i;
        row[i] = 1 / pivot;
    }
    return -1;
}

NDLI_API void ndli_band_solve(const double *a, int n, int width, double *b)
{
    for (int i = 0; i < n; i++) {
        const double *row = a + (size_t)i * (size_t)(width + 1) + width - i;
        for (int j = sbi_max_int(0, i - width); j < i; j++)
            b[i] -= row[j] * b[j];
    }
    for (int i = n - 1; i >= 0; i--) {
        const double *row = a + (size_t)i * (size_t)(width + 1) + width - i;
        b[i] *= row[i];
        for (int k = i + 1; k <= sbi_min_int(n - 1, i + width); k++)
            b[i] -= a[(size_t)k * (size_t)(width + 1) + (size_t)(width - k + i)] * b[k];
    }
}

/* ==== src/needle/rod_private.h ==== */
/* rod_private: what is inside a rod. Floor 6, internal: rod.c keeps it, rod_force.c reads forces from it, rod_step.c
 * moves it; rooms above couple it to tissue and change its nodes.
 *
 * State: x, v, a, director, theta. The directors d_j are a Bishop frame: each is its predecessor carried over by
 * parallel transport, so that the twist at node i is theta_i - theta_i-1. Within a step each edge carries its
 * director with itself instead (that keeps derivatives local); the reference twist that then arises between
 * neighbours is folded into theta when the step is taken (ndli_rod_moved). */
#ifndef NDL_ROD_PRIVATE_H
#define NDL_ROD_PRIVATE_H


/* Geometry of a rod in a shape that is tried: all that energies and their derivatives are made of. */
typedef struct ndli_rod_shape {
    ndli_v3 *tangent;  /* [edges] */
    double *length;    /* [edges] (m) */
    ndli_v3 *director; /* [edges] the state's, carried along with the edge */
    ndli_v3 *m1, *m2;  /* [edges] */
    ndli_v3 *binormal; /* [nodes] kb; inner nodes only */
    double *chi;       /* [nodes] 1 + t.t' */
    double *twist;     /* [nodes] (rad) */
    double *reference; /* [nodes] (rad) of it, what the directors make */
    double *lag;       /* [edges] (rad) how far the surroundings' springs are wound */
} ndli_rod_shape;

/* Second derivatives of the energy, lower half. Blocks of node i with nodes i, i - 1, i - 2. */
typedef struct ndli_rod_matrix {
    ndli_m3 (*node)[3];  /* [nodes] (N/m) */
    ndli_v3 (*cross)[4]; /* [edges] theta_j with nodes j - 1 .. j + 2 (N/rad) */
    double *turn;        /* [edges] theta_j with itself (N m) */
    double *turn_before; /* [edges] theta_j with theta_j-1 */
} ndli_rod_matrix;

struct ndl_rod {
    sb_allocator allocator;
    void *memory; /* the one block behind the arrays */
    int capacity;
    int node_count;
    double stretch, bending[2], torsion, line_density; /* N, N m^2, N m^2, kg/m */
    int plain; /* 1: isotropic and straight at rest, so that bending does not see the material frames */
    ndli_v3 gravity;
    double damping_stretch, damping_bending; /* s */
    int max_newton;
    double tolerance;

    ndli_v3 *x, *v, *a; /* [nodes] */
    ndli_v3 *director;  /* [edges] */
    double *theta;      /* [edges] (rad) material frame from the director, about the tangent; whole turns count */
    ndli_v3 *tangent;   /* [edges] of x */

    double *rest_length;    /* [edges] (m) */
    double (*rest_bend)[2]; /* [nodes] integrated rest curvature (2 tan of half the turn) towards m1 and m2; a density
                             * is this over the cell */
    double *mass;           /* [nodes] (kg) */
    double *cell;           /* [nodes] (m) length that bends at an inner node: half of both edges, of one at a clamp */

    unsigned char *held;         /* [nodes] */
    ndli_v3 *target;             /* [nodes] where held nodes will be, */
    ndli_v3 *target_velocity;    /* [nodes] with this velocity */
    unsigned char *has_velocity; /* [nodes] 1: target_velocity was given */
    unsigned char *turn_held;    /* [edges] */
    double *turn;                /* [edges] (rad) still to turn in the next step */
    int base_director_set;       /* 1: the base shall be turned so that its m1 becomes base_director */
    ndli_v3 base_director;
    ndli_v3 *force;            /* [nodes] dead loads (N) */
    double *torque;            /* [edges] (N m) */
    int grips;                 /* edges with a grip */
    double *grip, *grip_limit; /* [edges] the surroundings' grip: N m/rad; N m */
    double *anchor;            /* [edges] (rad) theta at which that spring is not wound */
    ndli_v3 *reaction;         /* [nodes] */
    double *reaction_torque;   /* [edges] */

    sb_vec3 *public_x, *public_v, *public_reaction; /* [nodes] what readings return */

    int energy_monitored; /* 1: energy_before is the energy (J) when supports or loads last changed */
    double energy_before;

    /* what follows holds nothing between calls */
    double viscous_stretch,
        viscous_bend;      /* within a step: damping time over dt, of strains measured from those below */
    double *old_length;    /* [edges] (m) */
    ndli_v3 *old_binormal; /* [nodes] */
    double (*old_bend)[4]; /* [nodes] curvature in the frame of the edge before, of the edge after */
    ndli_rod_shape shape;
    ndli_rod_matrix matrix;
    ndli_v3 *gradient;                           /* [nodes] */
    double *turn_gradient;                       /* [edges] */
    ndli_v3 *try_x, *best_x, *step_x;            /* [nodes] */
    double *try_theta, *best_theta, *step_theta; /* [edges] */
    ndli_v3 *predicted; /* [nodes] where inertia alone takes free nodes; targets of held ones */
    ndli_m3 *damping_before, *damping_after,
        *damping_weight;      /* [nodes] d kb/d e_i-1, d kb/d e_i, tau times stiffness */
    ndli_v3 *damping_tangent; /* [edges] */
    double *band;             /* [4 nodes][NDLI_ROD_WIDTH + 1] */
    double *unknown;          /* [4 nodes] */
    ndli_v3 *saved_nodes;     /* [NDLI_ROD_SAVED_NODES nodes] copies for undo */
    double *saved_reals;      /* [NDLI_ROD_SAVED_REALS nodes] */
    double *saved_turns;      /* [edges] */
};

/* Unknowns of node i: x_i, theta_i. A bend couples the first of x_i-1 (4 i - 4) to the last of x_i+1 (4 i + 6). */
enum { NDLI_ROD_WIDTH = 10, NDLI_ROD_SAVED_NODES = 6, NDLI_ROD_SAVED_REALS = 3 };

/* What of the second derivatives is wanted. */
enum {
    NDLI_ROD_EXACT = 1,   /* all; otherwise Gauss-Newton bending and twist, safe stretch: positive semidefinite */
    NDLI_ROD_NO_TWIST = 2 /* twist left out: for those who keep frames out of their unknowns and eliminate them, where
                           * a free tip makes it vanish */
};

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* ---- rod_force ---- */

SB_INLINE int ndli_rod_edges(const ndl_rod *rod) { return rod->node_count - 1; }
SB_INLINE int ndli_rod_has_edge(const ndl_rod *rod, int edge) { return rod && edge >= 0 && edge < ndli_rod_edges(rod); }
/* Nodes between two edges, which have a curvature. */
SB_INLINE int ndli_rod_is_inner(const ndl_rod *rod, int node) { return node > 0 && ndli_rod_has_edge(rod, node); }
/* Largest distance of a node from the origin (m): what positions are rounded by. */
NDLI_API double ndli_rod_reach(const ndl_rod *rod);
/* Parallel transport of v from the unit tangent p to the unit tangent q, not opposite to it. */
NDLI_API ndli_v3 ndli_rod_transport(ndli_v3 p, ndli_v3 q, ndli_v3 v);
/* Whether an edge may turn from the unit tangent p to the unit tangent q: not (nearly) back. */
NDLI_API int ndli_rod_may_turn(ndli_v3 p, ndli_v3 q);
/* v with its part along the unit vector t taken out, of length 1; any such vector where nothing is left of v. */
NDLI_API ndli_v3 ndli_rod_across(ndli_v3 v, ndli_v3 t);
/* shape = geometry at x and theta, directors carried from the state's. Returns -1, or the first node at which an edge
 * has no length, has turned back on its neighbour, or turned over since the state: no energy there. */
NDLI_API int ndli_rod_set_shape(const ndl_rod *rod, const ndli_v3 *x, const double *theta);
/* The same at other angles, tangents and directors of rod->shape as they are; frames (m1, m2): not only twists. */
NDLI_API void ndli_rod_set_angles(const ndl_rod *rod, const double *theta, int frames);
typedef struct ndli_rod_sums {
    double stretch, bend, twist; /* J */
    double grip;                 /* J: of the surroundings' springs, with what slips since the state */
    double viscous;              /* J: what damping adds within a step */
    double noise;                /* J: what rounding of positions leaves unknown of their sum */
    double turn_noise;           /* J: what rounding of angles does, where there is a grip; it is in noise, too */
} ndli_rod_sums;
/* Elastic energies of rod->shape. */
NDLI_API ndli_rod_sums ndli_rod_shape_energy(const ndl_rod *rod);
/* gradient[nodes] and turn_gradient[edges] (not NULL) of the elastic energy of rod->shape; matrix, when not NULL, its
 * second derivatives by the flags above. */
NDLI_API void ndli_rod_derivatives(const ndl_rod *rod, int flags, ndli_v3 *gradient, double *turn_gradient,
                                   ndli_rod_matrix *matrix);
/* turn_gradient, matrix->turn and matrix->turn_before of these alone. */
NDLI_API void ndli_rod_turn_derivatives(const ndl_rod *rod, int flags, double *turn_gradient, ndli_rod_matrix *matrix);
/* From here on every energy k/2 (w - w_rest)^2 has viscous k/2 (w - w_old)^2 beside it: damping as a potential,
 * which does not see how edges turn. w_old is the state's strain a time `ahead` on at its present rate. With strain
 * rates w_rate' = (2/dt)(w' - w) - w_rate, as Newmark has velocities, viscous is 2 damping/dt and ahead dt/2; with
 * implicit Euler's (w' - w)/dt they are damping/dt and 0. stretch = bend = 0: no more. */
NDLI_API void ndli_rod_set_viscous(ndl_rod *rod, double stretch, double bend, double ahead);
/* Takes what damping is at rod->shape: damping_before ... damping_tangent. For those who take v as unknown. */
NDLI_API void ndli_rod_set_damping_shape(ndl_rod *rod);
/* gradient += C v for that damping; returns v.C v (W). */
NDLI_API double ndli_rod_add_damping_force(const ndl_rod *rod, const ndli_v3 *v, ndli_v3 *gradient);
/* matrix->node += factor C */
NDLI_API void ndli_rod_add_damping_matrix(const ndl_rod *rod, double factor, ndli_rod_matrix *matrix);

/* ---- rod ---- */

/* After x or theta changed: tangents, frames (carried from where the edges were) and quasi-static theta follow, and
 * the surroundings' grip slips where it must. Returns -1, or the node that ndli_rod_set_shape names; nothing has
 * changed then, x and theta aside. */
NDLI_API int ndli_rod_moved(ndl_rod *rod);
/* The same, but nothing slips for good yet: the motion goes on. */
NDLI_API int ndli_rod_follow(ndl_rod *rod);
/* After rest_length or held changed: masses, and cells. Rest curvature stays integrated at each node. */
NDLI_API void ndli_rod_rest_changed(ndl_rod *rod);
/* rest_bend of the inner node i from its curvature (1/m) and cell. */
NDLI_API void ndli_rod_bend_to(ndl_rod *rod, int i, double curvature1, double curvature2);
NDLI_API int ndli_rod_static_options_valid(const ndl_rod_static_options *options);
/* Copies the state to what readings return. */
NDLI_API void ndli_rod_publish(ndl_rod *rod);
/* Copies of the state for undo, one deep: positions, motion, frames, what grips are wound by; not nodes and rests. */
NDLI_API void ndli_rod_save(ndl_rod *rod);
NDLI_API void ndli_rod_restore(ndl_rod *rod);

/* ---- rod_turn ---- */

/* Minimises the energy over the angles that are not held, nodes where they are and directors as they are. */
NDLI_API void ndli_rod_relax(ndl_rod *rod);
NDLI_API int ndli_rod_any_turn_held(const ndl_rod *rod);
/* Whether theta_j is no unknown. Nothing determines how a plain rod is turned that is held and gripped nowhere: its
 * first edge stays. */
NDLI_API int ndli_rod_turn_known(const ndl_rod *rod, int j, int any_held);
/* Torque per radian that is little beside twist, and keeps turns determined that no energy sees. */
NDLI_API double ndli_rod_turn_floor(const ndl_rod *rod, int j);

/* ---- rod_step ---- */

/* One step of implicit Euler by Newton's method, to the targets of held nodes; reactions are those of its end. 0:
 * Newton found none, and the state is as before. */
NDLI_API int ndli_rod_step_euler(ndl_rod *rod, double dt);

/* ---- rod_grip ---- */

/* Torque (N m) with which the grip of edge j, wound by `lag`, is against more of it. */
NDLI_API double ndli_rod_grip_moment(const ndl_rod *rod, int j, double lag);
/* Of rod->shape. */
NDLI_API void ndli_rod_add_grip_energy(const ndl_rod *rod, ndli_rod_sums *sums);
NDLI_API void ndli_rod_add_grip_derivatives(const ndl_rod *rod, double *turn_gradient, ndli_rod_matrix *matrix);
/* Anchors follow where springs are wound beyond their limit. */
NDLI_API void ndli_rod_slip(ndl_rod *rod);
/* ndl_rod_set_grip with valid arguments. */
NDLI_API void ndli_rod_set_grip(ndl_rod *rod, int edge, double stiffness, double limit);
/* Turns the frame of edge 0, which must be held against turning, by `angle` (rad) about its tangent, for those who move
 * nodes themselves; ndli_rod_moved, which must follow, turns the rest. */
NDLI_API void ndli_rod_turn_base(ndl_rod *rod, double angle);
/* Edge and edge + 1 are now the halves of what was edge. */
NDLI_API void ndli_rod_split_grip(ndl_rod *rod, int edge);
/* Edge `from` goes into edge `to`, whose theta is that of both; their lags were these. */
NDLI_API void ndli_rod_merge_grip(ndl_rod *rod, int from, int to, const double lags[2]);
typedef struct ndli_rod_spread {
    double *grip, *limit, *lag; /* [edges] */
} ndli_rod_spread;
/* Grip and lag of `count` - 1 new edges between the stations `at`, when the old nodes are at old_at (m). */
NDLI_API void ndli_rod_spread_grip(const ndl_rod *rod, const double *old_at, const double *at, int count,
                                   ndli_rod_spread *spread);

/* ---- rod_reshape ---- */

/* ndl_rod_reparameterise; x is `positions` to the bit. 2 <= count <= capacity; positions may be rod->x or rod->try_x,
 * but no other array of the rod. Does not publish. Returns -1, or the node at which `positions` make no rod: nothing
 * has changed then. */
NDLI_API int ndli_rod_reparameterise(ndl_rod *rod, const ndli_v3 *positions, int count);
#endif

#endif /* NDL_ROD_PRIVATE_H */

/* ==== src/needle/rod_force.c ==== */
/* rod_force: energies of a rod and their derivatives. Formulas: Bergou et al. 2008 and 2010, with the exact gradient of
 * the curvature binormal (edges may change length), and their second derivatives.
 *
 * With a = t_i-1, b = t_i, chi = 1 + a.b, tt = (a + b)/chi and the binormal kb = 2 a x b/chi:
 *     D0 = d kb/d e_i-1 = (-kb tt^T - (2/chi) [b])/l_i-1,   D1 = d kb/d e_i = (-kb tt^T + (2/chi) [a])/l_i
 * and in the frame of edge j the curvature is w_j = (kb.m2_j, -kb.m1_j). kb is at right angles to both edges, so that
 * the turning of the frames with their edges drops out of the first derivatives of w. */

/* Beyond this turn from edge to edge (2.94 rad) a rod counts as folded: its curvature grows without bound. */
static const double ndli_rod_least_chi = 0.02;

NDLI_API ndli_v3 ndli_rod_transport(ndli_v3 p, ndli_v3 q, ndli_v3 v)
{
    ndli_v3 b = ndli_cross(p, q);
    double c = ndli_dot(p, q);
    return ndli_madd(ndli_madd(ndli_cross(b, v), c, v), ndli_dot(b, v) / (1 + c), b);
}

NDLI_API int ndli_rod_may_turn(ndli_v3 p, ndli_v3 q) { return 1 + ndli_dot(p, q) > ndli_rod_least_chi; }

NDLI_API ndli_v3 ndli_rod_across(ndli_v3 v, ndli_v3 t)
{
    double size = ndli_norm(v), left;
    ndli_v3 across = ndli_madd(v, -ndli_dot(v, t), t);
    left = ndli_norm(across);
    if (!(left > 1e-6 * size)) {
        across = ndli_cross(t, fabs(t.x) < 0.6 ? ndli_v(1, 0, 0) : ndli_v(0, 1, 0));
        left = ndli_norm(across);
    }
    across = ndli_scale(1 / left, across);
    across = ndli_madd(across, -ndli_dot(across, t), t);
    return ndli_scale(1 / ndli_norm(across), across);
}

/* ---- shape ---- */

static void ndli_rod_set_frame(const ndl_rod *rod, int j, const double *theta)
{
    const ndli_rod_shape *shape = &rod->shape;
    ndli_v3 d = shape->director[j], across = ndli_cross(shape->tangent[j], d);
    double s, c;
    sbi_dense_sin_cos(theta[j], &s, &c);
    shape->lag[j] = theta[j] - rod->anchor[j];
    shape->m1[j] = ndli_madd(ndli_scale(c, d), s, across);
    shape->m2[j] = ndli_madd(ndli_scale(-s, d), c, across);
}

static int ndli_rod_set_edge(const ndl_rod *rod, int j, const ndli_v3 *x, const double *theta)
{
    const ndli_rod_shape *shape = &rod->shape;
    ndli_v3 e = ndli_sub(x[j + 1], x[j]);
    double length = ndli_norm(e);
    if (!(length > 1e-3 * rod->rest_length[j]) || !ndli_is_finite(length))
        return 0;
    shape->length[j] = length;
    shape->tangent[j] = ndli_scale(1 / length, e);
    if (!(1 + ndli_dot(rod->tangent[j], shape->tangent[j]) > ndli_rod_least_chi))
        return 0;
    shape->director[j] = ndli_rod_transport(rod->tangent[j], shape->tangent[j], rod->director[j]);
    ndli_rod_set_frame(rod, j, theta);
    return 1;
}

static int ndli_rod_set_bend(const ndl_rod *rod, int i, const double *theta)
{
    const ndli_rod_shape *shape = &rod->shape;
    ndli_v3 a = shape->tangent[i - 1], b = shape->tangent[i], carried;
    double chi = 1 + ndli_dot(a, b);
    if (!(chi > ndli_rod_least_chi))
        return 0;
    shape->chi[i] = chi;
    shape->binormal[i] = ndli_scale(2 / chi, ndli_cross(a, b));
    carried = ndli_rod_transport(a, b, shape->director[i - 1]);
    shape->reference[i] =
        sbi_dense_atan2(ndli_dot(ndli_cross(carried, shape->director[i]), b), ndli_dot(carried, shape->director[i]));
    shape->twist[i] = theta[i] - theta[i - 1] + shape->reference[i];
    return 1;
}

NDLI_API int ndli_rod_set_shape(const ndl_rod *rod, const ndli_v3 *x, const double *theta)
{
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        if (!ndli_rod_set_edge(rod, j, x, theta))
            return j + 1;
    for (int i = 1; i < rod->node_count - 1; i++)
        if (!ndli_rod_set_bend(rod, i, theta))
            return i;
    return -1;
}

NDLI_API void ndli_rod_set_angles(const ndl_rod *rod, const double *theta, int frames)
{
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        if (frames)
            ndli_rod_set_frame(rod, j, theta);
        else
            rod->shape.lag[j] = theta[j] - rod->anchor[j];
    }
    for (int i = 1; i < rod->node_count - 1; i++)
        rod->shape.twist[i] = theta[i] - theta[i - 1] + rod->shape.reference[i];
}

/* ---- energy ---- */

NDLI_API double ndli_rod_reach(const ndl_rod *rod)
{
    double reach = 0;
    for (int i = 0; i < rod->node_count; i++)
        for (int k = 0; k < 3; k++)
            reach = fmax(reach, fabs(ndli_component(rod->x[i], k)));
    return reach;
}

/* Curvature of node i in the frame of edge j. */
static void ndli_rod_material_curvature(const ndl_rod *rod, int i, int j, double w[2])
{
    w[0] = ndli_dot(rod->shape.binormal[i], rod->shape.m2[j]);
    w[1] = -ndli_dot(rod->shape.binormal[i], rod->shape.m1[j]);
}

static void ndli_rod_add_bend_energy(const ndl_rod *rod, int i, ndli_rod_sums *sums)
{
    double w[2];
    if (rod->plain) {
        ndli_v3 kb = rod->shape.binormal[i], change = ndli_sub(kb, rod->old_binormal[i]);
        double k = 0.5 * rod->bending[0] / rod->cell[i];
        sums->bend += k * ndli_dot(kb, kb);
        if (rod->viscous_bend > 0)
            sums->viscous += k * rod->viscous_bend * ndli_dot(change, change);
        return;
    }
    for (int f = 0; f < 2; f++) {
        ndli_rod_material_curvature(rod, i, i - 1 + f, w);
        for (int c = 0; c < 2; c++) {
            double k = 0.25 * rod->bending[c] / rod->cell[i], bent = w[c] - rod->rest_bend[i][c];
            double change = w[c] - rod->old_bend[i][2 * f + c];
            sums->bend += k * bent * bent;
            if (rod->viscous_bend > 0)
                sums->viscous += k * rod->viscous_bend * change * change;
        }
    }
}

NDLI_API ndli_rod_sums ndli_rod_shape_energy(const ndl_rod *rod)
{
    ndli_rod_sums sums = {0, 0, 0, 0, 0, 0, 0};
    double reach = ndli_rod_reach(rod);
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        double strain = rod->shape.length[j] / rod->rest_length[j] - 1, unknown = 2.3e-16 * reach / rod->rest_length[j];
        sums.stretch += 0.5 * rod->stretch * rod->rest_length[j] * strain * strain;
        if (rod->viscous_stretch > 0) {
            double change = (rod->shape.length[j] - rod->old_length[j]) / rod->rest_length[j];
            sums.viscous += 0.5 * rod->viscous_stretch * rod->stretch * rod->rest_length[j] * change * change;
            sums.noise +=
                rod->viscous_stretch * rod->stretch * rod->rest_length[j] * (fabs(change) + unknown) * unknown;
        }
        sums.noise += rod->stretch * rod->rest_length[j] * (fabs(strain) + unknown) * unknown;
    }
    for (int i = 1; i < rod->node_count - 1; i++) {
        ndli_rod_add_bend_energy(rod, i, &sums);
        sums.twist += 0.5 * rod->torsion / rod->cell[i] * rod->shape.twist[i] * rod->shape.twist[i];
    }
    if (rod->grips > 0)
        ndli_rod_add_grip_energy(rod, &sums);
    sums.noise += sums.turn_noise + 4.5e-15 * (sums.stretch + sums.bend + sums.twist + sums.grip + sums.viscous);
    return sums;
}

/* ---- derivatives ---- */

/* First and second derivatives of the energy at one node in e_i-1, e_i (0, 1) and theta_i-1, theta_i (0, 1). */
typedef struct ndli_rod_local {
    ndli_v3 edge[2];
    double turn[2];
    ndli_m3 edges[2][2]; /* [1][0] is the transpose of [0][1] and not kept */
    ndli_v3 cross[2][2]; /* [edge][theta] */
    double turns[2], turns_between;
} ndli_rod_local;

/* What the curvature of node i depends on. */
typedef struct ndli_rod_bend {
    ndli_v3 a, b, tt, kb;
    double l[2], chi;
    ndli_m3 d[2]; /* D0, D1 */
} ndli_rod_bend;

static ndli_rod_bend ndli_rod_get_bend(const ndl_rod *rod, int i)
{
    const ndli_rod_shape *shape = &rod->shape;
    ndli_rod_bend bend;
    bend.a = shape->tangent[i - 1];
    bend.b = shape->tangent[i];
    bend.kb = shape->binormal[i];
    bend.chi = shape->chi[i];
    bend.l[0] = shape->length[i - 1];
    bend.l[1] = shape->length[i];
    bend.tt = ndli_scale(1 / bend.chi, ndli_add(bend.a, bend.b));
    for (int k = 0; k < 2; k++) {
        bend.d[k] = ndli_m_zero();
        ndli_m_add_outer(&bend.d[k], -1 / bend.l[k], bend.kb, bend.tt);
    }
    ndli_m_add_cross(&bend.d[0], -2 / (bend.chi * bend.l[0]), bend.b);
    ndli_m_add_cross(&bend.d[1], 2 / (bend.chi * bend.l[1]), bend.a);
    return bend;
}

/* edges[][] += D^T q D */
static void ndli_rod_add_gauss_newton(const ndli_rod_bend *bend, const ndli_m3 *q, ndli_rod_local *local)
{
    for (int k = 0; k < 2; k++) {
        ndli_m3 qd = ndli_m_mul(q, &bend->d[k]);
        for (int r = 0; r <= k; r++) {
            ndli_m3 product = ndli_m_tmul(&bend->d[r], &qd);
            ndli_m_add(&local->edges[r][k], 1, &product);
        }
    }
}

/* *a += s (u v^T + v u^T) */
static void ndli_rod_add_symmetric(ndli_m3 *a, double s, ndli_v3 u, ndli_v3 v)
{
    ndli_m_add_outer(a, s, u, v);
    ndli_m_add_outer(a, s, v, u);
}

/* edges[][] += second derivative of p.kb for a constant p; g_k = D_k^T p:
 *     00: -(g0 tt^T + tt g0^T)/l0 - (p.kb) (I - a a^T)/(chi l0^2), 11 with b, g1, l1
 *     01: (-tt g1^T - ((p.kb) (I - b b^T) + 2 [p] (I - b b^T))/(chi l1) - (l0/l1) g0 (tt - b)^T)/l0 */
static void ndli_rod_add_curvature_hessian(const ndli_rod_bend *bend, ndli_v3 p, ndli_rod_local *local)
{
    double along = ndli_dot(p, bend->kb), l0 = bend->l[0], l1 = bend->l[1];
    ndli_v3 g[2], t[2];
    ndli_m3 *mixed = &local->edges[0][1];
    t[0] = bend->a;
    t[1] = bend->b;
    for (int k = 0; k < 2; k++) {
        double s = along / (bend->chi * bend->l[k] * bend->l[k]);
        g[k] = ndli_m_tapply(&bend->d[k], p);
        ndli_rod_add_symmetric(&local->edges[k][k], -1 / bend->l[k], g[k], bend->tt);
        ndli_m_add_identity(&local->edges[k][k], -s);
        ndli_m_add_outer(&local->edges[k][k], s, t[k], t[k]);
    }
    ndli_m_add_outer(mixed, -1 / l0, bend->tt, g[1]);
    ndli_m_add_identity(mixed, -along / (bend->chi * l0 * l1));
    ndli_m_add_outer(mixed, along / (bend->chi * l0 * l1), bend->b, bend->b);
    ndli_m_add_cross(mixed, -2 / (bend->chi * l0 * l1), p);
    ndli_m_add_outer(mixed, 2 / (bend->chi * l0 * l1), ndli_cross(p, bend->b), bend->b);
    ndli_m_add_outer(mixed, -1 / l1, g[0], ndli_sub(bend->tt, bend->b));
}

static void ndli_rod_plain_bend(const ndl_rod *rod, int i, int flags, const ndli_rod_bend *bend, int wanted,
                                ndli_rod_local *local)
{
    double k = rod->bending[0] / rod->cell[i];
    ndli_v3 p = ndli_scale(k, bend->kb);
    ndli_m3 q = ndli_m_zero();
    if (rod->viscous_bend > 0) {
        p = ndli_madd(p, k * rod->viscous_bend, ndli_sub(bend->kb, rod->old_binormal[i]));
        k *= 1 + rod->viscous_bend;
    }
    for (int e = 0; e < 2; e++)
        local->edge[e] = ndli_m_tapply(&bend->d[e], p);
    if (!wanted)
        return;
    ndli_m_add_identity(&q, k);
    ndli_rod_add_gauss_newton(bend, &q, local);
    if (flags & NDLI_ROD_EXACT)
        ndli_rod_add_curvature_hessian(bend, p, local);
}

/* Curvature w of node i in the frame of edge i - 1 + f, moment s against it and its stiffness, damping included. */
static void ndli_rod_frame_moment(const ndl_rod *rod, int i, int f, double w[2], double s[2], double stiff[2])
{
    ndli_rod_material_curvature(rod, i, i - 1 + f, w);
    for (int k = 0; k < 2; k++) {
        stiff[k] = rod->bending[k] / (2 * rod->cell[i]);
        s[k] = stiff[k] * (w[k] - rod->rest_bend[i][k]);
        if (rod->viscous_bend > 0) {
            s[k] += stiff[k] * rod->viscous_bend * (w[k] - rod->old_bend[i][2 * f + k]);
            stiff[k] *= 1 + rod->viscous_bend;
        }
    }
}

/* Bending seen from the frame of edge i - 1 + f. Exact second derivatives have two more terms: of the frame's turning
 * with its edge, (kb p^T + p kb^T)/(2 l^2), and of the curvature in the angle. */
static void ndli_rod_frame_bend(const ndl_rod *rod, int i, int f, int flags, const ndli_rod_bend *bend, int wanted,
                                ndli_rod_local *local)
{
    int j = i - 1 + f;
    ndli_v3 m1 = rod->shape.m1[j], m2 = rod->shape.m2[j], p, mixed;
    double w[2], s[2], stiff[2];
    ndli_m3 q = ndli_m_zero();
    ndli_rod_frame_moment(rod, i, f, w, s, stiff);
    p = ndli_madd(ndli_scale(s[0], m2), -s[1], m1);
    for (int e = 0; e < 2; e++)
        local->edge[e] = ndli_add(local->edge[e], ndli_m_tapply(&bend->d[e], p));
    local->turn[f] += s[0] * w[1] - s[1] * w[0];
    if (!wanted)
        return;
    ndli_m_add_outer(&q, stiff[0], m2, m2);
    ndli_m_add_outer(&q, stiff[1], m1, m1);
    ndli_rod_add_gauss_newton(bend, &q, local);
    mixed = ndli_madd(ndli_scale(stiff[0] * w[1], m2), stiff[1] * w[0], m1);
    local->turns[f] += stiff[0] * w[1] * w[1] + stiff[1] * w[0] * w[0];
    if (flags & NDLI_ROD_EXACT) {
        ndli_rod_add_curvature_hessian(bend, p, local);
        ndli_rod_add_symmetric(&local->edges[f][f], 0.5 / (bend->l[f] * bend->l[f]), bend->kb, p);
        mixed = ndli_madd(ndli_madd(mixed, -s[0], m1), -s[1], m2);
        local->turns[f] -= s[0] * w[0] + s[1] * w[1];
    }
    for (int e = 0; e < 2; e++)
        local->cross[e][f] = ndli_add(local->cross[e][f], ndli_m_tapply(&bend->d[e], mixed));
}

/* d m/d e = kb/(2 l) on both edges; second derivatives (symmetric parts: the rest is holonomy)
 *     00: -(kb (a + tt)^T + (a + tt) kb^T)/(4 l0^2), 11 with b, l1;   01: D1/(2 l0) */
static void ndli_rod_twist_local(const ndl_rod *rod, int i, int flags, const ndli_rod_bend *bend, int wanted,
                                 ndli_rod_local *local)
{
    double k = rod->torsion / rod->cell[i], moment = k * rod->shape.twist[i];
    ndli_v3 g[2];
    for (int e = 0; e < 2; e++) {
        g[e] = ndli_scale(0.5 / bend->l[e], bend->kb);
        local->edge[e] = ndli_madd(local->edge[e], moment, g[e]);
    }
    local->turn[0] -= moment;
    local->turn[1] += moment;
    if (!wanted || (flags & NDLI_ROD_NO_TWIST))
        return;
    for (int e = 0; e < 2; e++) {
        ndli_m_add_outer(&local->edges[e][e], k, g[e], g[e]);
        local->cross[e][0] = ndli_madd(local->cross[e][0], -k, g[e]);
        local->cross[e][1] = ndli_madd(local->cross[e][1], k, g[e]);
        local->turns[e] += k;
    }
    ndli_m_add_outer(&local->edges[0][1], k, g[0], g[1]);
    local->turns_between -= k;
    if (!(flags & NDLI_ROD_EXACT))
        return;
    for (int e = 0; e < 2; e++)
        ndli_rod_add_symmetric(&local->edges[e][e], -0.25 * moment / (bend->l[e] * bend->l[e]), bend->kb,
                               ndli_add(e ? bend->b : bend->a, bend->tt));
    ndli_m_add(&local->edges[0][1], 0.5 * moment / bend->l[0], &bend->d[1]);
}

/* Edge derivatives to nodes: e_i-1 = x_i - x_i-1, e_i = x_i+1 - x_i. */
static void ndli_rod_scatter(const ndli_rod_local *local, int i, ndli_v3 *gradient, double *turn_gradient,
                             ndli_rod_matrix *matrix)
{
    const ndli_m3 *h00 = &local->edges[0][0], *h01 = &local->edges[0][1], *h11 = &local->edges[1][1];
    ndli_m3 h10 = ndli_m_transpose(h01);
    gradient[i - 1] = ndli_sub(gradient[i - 1], local->edge[0]);
    gradient[i] = ndli_add(gradient[i], ndli_sub(local->edge[0], local->edge[1]));
    gradient[i + 1] = ndli_add(gradient[i + 1], local->edge[1]);
    turn_gradient[i - 1] += local->turn[0];
    turn_gradient[i] += local->turn[1];
    if (!matrix)
        return;
    ndli_m_add(&matrix->node[i - 1][0], 1, h00);
    ndli_m_add(&matrix->node[i][0], 1, h00);
    ndli_m_add(&matrix->node[i][0], -1, h01);
    ndli_m_add(&matrix->node[i][0], -1, &h10);
    ndli_m_add(&matrix->node[i][0], 1, h11);
    ndli_m_add(&matrix->node[i + 1][0], 1, h11);
    ndli_m_add(&matrix->node[i][1], -1, h00);
    ndli_m_add(&matrix->node[i][1], 1, &h10);
    ndli_m_add(&matrix->node[i + 1][1], 1, &h10);
    ndli_m_add(&matrix->node[i + 1][1], -1, h11);
    ndli_m_add(&matrix->node[i + 1][2], -1, &h10);
    for (int f = 0; f < 2; f++) {
        int j = i - 1 + f;
        ndli_v3 *cross = matrix->cross[j] + (f ? 0 : 1);
        cross[0] = ndli_sub(cross[0], local->cross[0][f]);
        cross[1] = ndli_add(cross[1], ndli_sub(local->cross[0][f], local->cross[1][f]));
        cross[2] = ndli_add(cross[2], local->cross[1][f]);
        matrix->turn[j] += local->turns[f];
    }
    matrix->turn_before[i] += local->turns_between;
}

static void ndli_rod_stretch(const ndl_rod *rod, int j, int flags, ndli_v3 *gradient, ndli_rod_matrix *matrix)
{
    ndli_v3 t = rod->shape.tangent[j];
    double rest = rod->rest_length[j], l = rod->shape.length[j], tension = rod->stretch * (l / rest - 1), across;
    double stiff = rod->stretch / rest;
    ndli_v3 g;
    ndli_m3 h = ndli_m_zero();
    if (rod->viscous_stretch > 0) {
        tension += rod->viscous_stretch * stiff * (l - rod->old_length[j]);
        stiff *= 1 + rod->viscous_stretch;
    }
    across = tension / l;
    g = ndli_scale(tension, t);
    gradient[j] = ndli_sub(gradient[j], g);
    gradient[j + 1] = ndli_add(gradient[j + 1], g);
    if (!matrix)
        return;
    if (!(flags & NDLI_ROD_EXACT) && across < 0)
        across = 0;
    ndli_m_add_identity(&h, across);
    ndli_m_add_outer(&h, stiff - across, t, t);
    ndli_m_add(&matrix->node[j][0], 1, &h);
    ndli_m_add(&matrix->node[j + 1][0], 1, &h);
    ndli_m_add(&matrix->node[j + 1][1], -1, &h);
}

NDLI_API void ndli_rod_derivatives(const ndl_rod *rod, int flags, ndli_v3 *gradient, double *turn_gradient,
                                   ndli_rod_matrix *matrix)
{
    size_t nodes = (size_t)rod->node_count;
    memset(gradient, 0, nodes * sizeof *gradient);
    memset(turn_gradient, 0, nodes * sizeof *turn_gradient);
    if (matrix) {
        memset(matrix->node, 0, nodes * sizeof *matrix->node);
        memset(matrix->cross, 0, nodes * sizeof *matrix->cross);
        memset(matrix->turn, 0, nodes * sizeof *matrix->turn);
        memset(matrix->turn_before, 0, nodes * sizeof *matrix->turn_before);
    }
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        ndli_rod_stretch(rod, j, flags, gradient, matrix);
    for (int i = 1; i < rod->node_count - 1; i++) {
        ndli_rod_bend bend = ndli_rod_get_bend(rod, i);
        ndli_rod_local local;
        memset(&local, 0, sizeof local);
        if (rod->plain)
            ndli_rod_plain_bend(rod, i, flags, &bend, matrix != NULL, &local);
        else
            for (int f = 0; f < 2; f++)
                ndli_rod_frame_bend(rod, i, f, flags, &bend, matrix != NULL, &local);
        ndli_rod_twist_local(rod, i, flags, &bend, matrix != NULL, &local);
        ndli_rod_scatter(&local, i, gradient, turn_gradient, matrix);
    }
    if (rod->grips > 0)
        ndli_rod_add_grip_derivatives(rod, turn_gradient, matrix);
}

NDLI_API void ndli_rod_turn_derivatives(const ndl_rod *rod, int flags, double *turn_gradient, ndli_rod_matrix *matrix)
{
    size_t bytes = (size_t)rod->node_count * sizeof(double);
    memset(turn_gradient, 0, bytes);
    memset(matrix->turn, 0, bytes);
    memset(matrix->turn_before, 0, bytes);
    for (int i = 1; i < rod->node_count - 1; i++) {
        double k = rod->torsion / rod->cell[i], moment = k * rod->shape.twist[i];
        for (int f = 0; f < 2; f++) {
            double gradient = 0, turns = 0, w[2], s[2], stiff[2];
            if (!rod->plain) {
                ndli_rod_frame_moment(rod, i, f, w, s, stiff);
                gradient = s[0] * w[1] - s[1] * w[0];
                turns = stiff[0] * w[1] * w[1] + stiff[1] * w[0] * w[0];
                if (flags & NDLI_ROD_EXACT)
                    turns -= s[0] * w[0] + s[1] * w[1];
            }
            turn_gradient[i - 1 + f] += gradient + (f ? moment : -moment);
            matrix->turn[i - 1 + f] += turns + k;
        }
        matrix->turn_before[i] -= k;
    }
    if (rod->grips > 0)
        ndli_rod_add_grip_derivatives(rod, turn_gradient, matrix);
}

/* ---- damping within a step ---- */

NDLI_API void ndli_rod_set_viscous(ndl_rod *rod, double stretch, double bend, double ahead)
{
    rod->viscous_stretch = stretch;
    rod->viscous_bend = bend;
    if (!(stretch > 0) && !(bend > 0))
        return;
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        double rate = ndli_dot(rod->shape.tangent[j], ndli_sub(rod->v[j + 1], rod->v[j]));
        rod->old_length[j] = rod->shape.length[j] + ahead * rate;
    }
    for (int i = 1; i < rod->node_count - 1; i++) {
        ndli_rod_bend at = ndli_rod_get_bend(rod, i);
        ndli_v3 rate = ndli_add(ndli_m_apply(&at.d[0], ndli_sub(rod->v[i], rod->v[i - 1])),
                                ndli_m_apply(&at.d[1], ndli_sub(rod->v[i + 1], rod->v[i])));
        ndli_v3 kb = ndli_madd(at.kb, ahead, rate);
        rod->old_binormal[i] = kb;
        for (int f = 0; f < 2; f++) {
            rod->old_bend[i][2 * f] = ndli_dot(kb, rod->shape.m2[i - 1 + f]);
            rod->old_bend[i][2 * f + 1] = -ndli_dot(kb, rod->shape.m1[i - 1 + f]);
        }
    }
}

/* ---- damping ----
 * Stretching: D = 1/2 sum (K_d/lb)(t.dv)^2 with K_d = damping_stretch K_s; bending: C = damping_bending times the
 * Gauss-Newton matrix of bending. */

NDLI_API void ndli_rod_set_damping_shape(ndl_rod *rod)
{
    memcpy(rod->damping_tangent, rod->shape.tangent, (size_t)ndli_rod_edges(rod) * sizeof *rod->damping_tangent);
    for (int i = 1; i < rod->node_count - 1; i++) {
        ndli_rod_bend bend = ndli_rod_get_bend(rod, i);
        double scale = rod->damping_bending / rod->cell[i];
        ndli_m3 *q = &rod->damping_weight[i];
        rod->damping_before[i] = bend.d[0];
        rod->damping_after[i] = bend.d[1];
        *q = ndli_m_zero();
        if (rod->plain)
            ndli_m_add_identity(q, scale * rod->bending[0]);
        else
            for (int j = i - 1; j <= i; j++) {
                ndli_m_add_outer(q, 0.5 * scale * rod->bending[0], rod->shape.m2[j], rod->shape.m2[j]);
                ndli_m_add_outer(q, 0.5 * scale * rod->bending[1], rod->shape.m1[j], rod->shape.m1[j]);
            }
    }
}

NDLI_API double ndli_rod_add_damping_force(const ndl_rod *rod, const ndli_v3 *v, ndli_v3 *gradient)
{
    double power = 0;
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        ndli_v3 t = rod->damping_tangent[j];
        double rate = ndli_dot(t, ndli_sub(v[j + 1], v[j]));
        ndli_v3 g = ndli_scale(rod->damping_stretch * rod->stretch / rod->rest_length[j] * rate, t);
        power += rod->damping_stretch * rod->stretch / rod->rest_length[j] * rate * rate;
        gradient[j] = ndli_sub(gradient[j], g);
        gradient[j + 1] = ndli_add(gradient[j + 1], g);
    }
    for (int i = 1; i < rod->node_count - 1; i++) {
        ndli_v3 rate = ndli_add(ndli_m_apply(&rod->damping_before[i], ndli_sub(v[i], v[i - 1])),
                                ndli_m_apply(&rod->damping_after[i], ndli_sub(v[i + 1], v[i])));
        ndli_v3 p = ndli_m_apply(&rod->damping_weight[i], rate);
        ndli_v3 g0 = ndli_m_tapply(&rod->damping_before[i], p), g1 = ndli_m_tapply(&rod->damping_after[i], p);
        power += ndli_dot(p, rate);
        gradient[i - 1] = ndli_sub(gradient[i - 1], g0);
        gradient[i] = ndli_add(gradient[i], ndli_sub(g0, g1));
        gradient[i + 1] = ndli_add(gradient[i + 1], g1);
    }
    return power;
}

NDLI_API void ndli_rod_add_damping_matrix(const ndl_rod *rod, double factor, ndli_rod_matrix *matrix)
{
    int bends = rod->damping_bending > 0 ? rod->node_count - 1 : 0;
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        double k = factor * rod->damping_stretch * rod->stretch / rod->rest_length[j];
        ndli_v3 t = rod->damping_tangent[j];
        ndli_m_add_outer(&matrix->node[j][0], k, t, t);
        ndli_m_add_outer(&matrix->node[j + 1][0], k, t, t);
        ndli_m_add_outer(&matrix->node[j + 1][1], -k, t, t);
    }
    for (int i = 1; i < bends; i++) {
        ndli_m3 j[3]; /* d kb/d x_i-1, x_i, x_i+1 */
        j[0] = j[1] = j[2] = ndli_m_zero();
        ndli_m_add(&j[0], -1, &rod->damping_before[i]);
        ndli_m_add(&j[1], 1, &rod->damping_before[i]);
        ndli_m_add(&j[1], -1, &rod->damping_after[i]);
        ndli_m_add(&j[2], 1, &rod->damping_after[i]);
        for (int r = 0; r < 3; r++)
            for (int c = 0; c <= r; c++) {
                ndli_m3 right = ndli_m_mul(&rod->damping_weight[i], &j[c]), block = ndli_m_tmul(&j[r], &right);
                ndli_m_add(&matrix->node[i - 1 + r][r - c], factor, &block);
            }
    }
}

/* ==== src/needle/rod_turn.c ==== */
/* rod_turn: minimises a rod's potential over its frames alone. */

static double ndli_rod_turn_potential(const ndl_rod *rod, const double *theta, double *noise)
{
    ndli_rod_sums sums;
    double potential;
    ndli_rod_set_angles(rod, theta, !rod->plain); /* the bending of a plain rod does not see its frames */
    sums = ndli_rod_shape_energy(rod);
    potential = sums.bend + sums.twist + sums.grip + sums.viscous; /* stretching stays the same, and would drown it */
    *noise = 4.5e-15 * potential + sums.turn_noise;
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        potential -= rod->torque[j] * theta[j];
        *noise += 4.5e-15 * fabs(rod->torque[j] * theta[j]);
    }
    return potential;
}

NDLI_API int ndli_rod_any_turn_held(const ndl_rod *rod)
{
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        if (rod->turn_held[j])
            return 1;
    return 0;
}

NDLI_API int ndli_rod_turn_known(const ndl_rod *rod, int j, int any_held)
{
    return rod->turn_held[j] || (j == 0 && !any_held && rod->plain && rod->grips == 0);
}

NDLI_API double ndli_rod_turn_floor(const ndl_rod *rod, int j) { return 1e-9 * rod->torsion / rod->rest_length[j]; }

/* step_theta = a Newton step for the angles; 0 when the matrix is not positive definite. */
static int ndli_rod_turn_step(ndl_rod *rod, int flags)
{
    int n = ndli_rod_edges(rod), any_held = ndli_rod_any_turn_held(rod);
    ndli_rod_turn_derivatives(rod, flags, rod->turn_gradient, &rod->matrix);
    for (int j = 0; j < n; j++) {
        int known = ndli_rod_turn_known(rod, j, any_held), before = j > 0 && !ndli_rod_turn_known(rod, j - 1, any_held);
        rod->band[2 * j] = !known && before ? rod->matrix.turn_before[j] : 0;
        rod->band[2 * j + 1] = known ? 1 : rod->matrix.turn[j] + ndli_rod_turn_floor(rod, j);
        rod->step_theta[j] = known ? 0 : rod->torque[j] - rod->turn_gradient[j];
    }
    if (ndli_band_factor(rod->band, n, 1, 1e-14) >= 0)
        return 0;
    ndli_band_solve(rod->band, n, 1, rod->step_theta);
    return 1;
}

/* Whether Newton is at an end although its last step was not below what matters: where springs slip angles may be
 * large and their rounding, too. The whole step (largest change, change before) promised no more than noise. */
static int ndli_rod_turns_settled(const ndl_rod *rod, double largest, double before, double noise)
{
    double promised = 0;
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        promised += 0.5 * fabs(rod->step_theta[j] * (rod->torque[j] - rod->turn_gradient[j]));
    return rod->grips > 0 && promised <= noise && largest > 0.25 * before;
}

NDLI_API void ndli_rod_relax(ndl_rod *rod)
{
    size_t bytes = (size_t)ndli_rod_edges(rod) * sizeof(double);
    double noise, potential, before = 0;
    /* at worst one more spring begins to slip in each */
    int most = 50 + 2 * rod->grips;
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    potential = ndli_rod_turn_potential(rod, rod->theta, &noise);
    for (int iteration = 0; iteration < most; iteration++) {
        double size = 1, largest = 0, next = potential;
        if (!ndli_rod_turn_step(rod, NDLI_ROD_EXACT) && !ndli_rod_turn_step(rod, 0))
            break;
        for (int j = 0; j < ndli_rod_edges(rod); j++)
            largest = fmax(largest, fabs(rod->step_theta[j]));
        for (int halving = 0; halving < 30; halving++, size *= 0.5) {
            for (int j = 0; j < ndli_rod_edges(rod); j++)
                rod->try_theta[j] = rod->theta[j] + size * rod->step_theta[j];
            next = ndli_rod_turn_potential(rod, rod->try_theta, &noise);
            if (next <= potential + noise)
                break;
        }
        if (next > potential + noise)
            break;
        memcpy(rod->theta, rod->try_theta, bytes);
        potential = next;
        if (largest < 1e-13 || ndli_rod_turns_settled(rod, largest, before, noise))
            break;
        before = size * largest;
    }
    ndli_rod_set_angles(rod, rod->theta, 1);
}

/* ==== src/needle/rod.c ==== */
/* rod: creation, supports, loads, nodes and readings of a rod. */

static const unsigned ndli_rod_cookie = 0x726f6431u, ndli_rod_static_cookie = 0x726f6432u;
static const double ndli_rod_pi = 3.141592653589793;

/* ---- what a rod is made of ---- */

NDL_API sb_result ndl_rod_section_preset(ndl_rod_preset preset, ndl_rod_section *section)
{
    static const double table[3][5] = {/* outer and inner diameter (mm), GPa, Poisson's ratio, density */
                                       {1.270, 0, 193, 0.29, 8000},
                                       {0.83, 0, 75, 0.33, 6450},
                                       {0.7176, 0.413, 193, 0.29, 8000}};
    const double *row;
    if (!section || preset < NDL_STYLET_18G || preset > NDL_HYPODERMIC_22G)
        return SB_ERROR_ARGUMENT;
    row = table[preset - NDL_STYLET_18G];
    section->radius = (sb_real)(0.5e-3 * row[0]);
    section->inner_radius = (sb_real)(0.5e-3 * row[1]);
    section->young = (sb_real)(1e9 * row[2]);
    section->poisson = (sb_real)row[3];
    section->density = (sb_real)row[4];
    return SB_OK;
}

NDL_API ndl_rod_stiffness ndl_rod_stiffness_of(const ndl_rod_section *section)
{
    ndl_rod_stiffness stiffness;
    double r2, i2, area, bending;
    memset(&stiffness, 0, sizeof stiffness);
    if (!section)
        return stiffness;
    r2 = (double)section->radius * (double)section->radius;
    i2 = (double)section->inner_radius * (double)section->inner_radius, area = ndli_rod_pi * (r2 - i2);
    bending = 0.25 * (double)section->young * ndli_rod_pi * (r2 * r2 - i2 * i2);
    stiffness.stretch = (sb_real)((double)section->young * area);
    stiffness.bending[0] = stiffness.bending[1] = (sb_real)bending;
    stiffness.twist = (sb_real)(bending / (1 + (double)section->poisson));
    stiffness.line_density = (sb_real)((double)section->density * area);
    return stiffness;
}

/* ---- creation ---- */

NDL_API ndl_rod_def ndl_default_rod_def(void)
{
    ndl_rod_def def;
    memset(&def, 0, sizeof def);
    ndl_rod_section_preset(NDL_STYLET_18G, &def.section);
    def.rest = NDL_REST_STRAIGHT;
    def.clamped = 1;
    def.damping_stretch = def.damping_bending = (sb_real)1e-4;
    def.max_newton = 30;
    def.tolerance = (sb_real)1e-6;
    def.cookie = ndli_rod_cookie;
    return def;
}

NDL_API ndl_rod_static_options ndl_default_rod_static_options(void)
{
    ndl_rod_static_options options;
    memset(&options, 0, sizeof options);
    options.max_newton = 500;
    options.tolerance = (sb_real)1e-9;
    options.cookie = ndli_rod_static_cookie;
    return options;
}

NDLI_API int ndli_rod_static_options_valid(const ndl_rod_static_options *options)
{
    return options->cookie == ndli_rod_static_cookie && options->max_newton >= 1 && options->tolerance > 0 &&
           options->tolerance < 1;
}

static int ndli_rod_positive(sb_real x) { return x > 0 && x <= SB_REAL_MAX; }
static int ndli_rod_not_negative(sb_real x) { return x >= 0 && x <= SB_REAL_MAX; }

static sb_result ndli_rod_check_material(const ndl_rod_def *def, ndl_rod_stiffness *stiffness, sb_error *error)
{
    const ndl_rod_section *s = &def->section;
    if (def->stiffness) {
        *stiffness = *def->stiffness;
    } else {
        if (!ndli_rod_positive(s->radius) || !ndli_rod_not_negative(s->inner_radius) || !(s->inner_radius < s->radius))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "section: radius must be above 0, inner_radius in [0, radius)");
        if (!ndli_rod_positive(s->young) || !ndli_rod_positive(s->density) || !(s->poisson > -1) ||
            !(s->poisson <= (sb_real)0.5))
            return sbi_fail(error, SB_ERROR_ARGUMENT,
                            "section: young and density must be above 0, poisson in (-1, 0.5]");
        *stiffness = ndl_rod_stiffness_of(s);
    }
    if (!ndli_rod_positive(stiffness->stretch) || !ndli_rod_positive(stiffness->bending[0]) ||
        !ndli_rod_positive(stiffness->bending[1]) || !ndli_rod_positive(stiffness->twist) ||
        !ndli_rod_positive(stiffness->line_density))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "stiffness and line_density must be finite and above 0");
    return SB_OK;
}

static sb_result ndli_rod_check_def(const ndl_rod_def *def, sb_error *error)
{
    if (def->cookie != ndli_rod_cookie)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def does not come from ndl_default_rod_def()");
    if (!def->nodes || def->node_count < 2)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a rod needs nodes, at least 2");
    if (def->capacity != 0 && def->capacity < def->node_count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "capacity %d is below node_count %d", def->capacity, def->node_count);
    if (def->rest < NDL_REST_STRAIGHT || def->rest > NDL_REST_CURVATURE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "rest has no such kind");
    if (def->rest == NDL_REST_CURVATURE && !def->rest_curvature)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "NDL_REST_CURVATURE needs rest_curvature");
    if (!sb_v3_is_finite(def->director) || !sb_v3_is_finite(def->gravity))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "director or gravity is not finite");
    if (!ndli_rod_not_negative(def->damping_stretch) || !ndli_rod_not_negative(def->damping_bending))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "damping must be finite and not negative");
    if (def->max_newton < 1 || !(def->tolerance > 0) || !(def->tolerance < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_newton must be at least 1, tolerance in (0, 1)");
    if (def->clamped != 0 && def->clamped != 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "clamped must be 0 or 1");
    for (int i = 0; i < def->node_count; i++) {
        if (!sb_v3_is_finite(def->nodes[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "node %d is not finite", i);
        if (def->rest == NDL_REST_CURVATURE &&
            (!sb_is_finite(def->rest_curvature[2 * i]) || !sb_is_finite(def->rest_curvature[2 * i + 1])))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "the rest curvature of node %d is not finite", i);
    }
    return SB_OK;
}

/* All arrays, for `nodes` nodes; called once to measure and once to hand out. */
static void ndli_rod_layout(ndl_rod *rod, sbi_arena *arena, int nodes)
{
    size_t n = (size_t)nodes, v = sizeof(ndli_v3), d = sizeof(double), m = sizeof(ndli_m3);
    ndli_v3 **vectors[] = {&rod->x,
                           &rod->v,
                           &rod->a,
                           &rod->director,
                           &rod->tangent,
                           &rod->target,
                           &rod->target_velocity,
                           &rod->force,
                           &rod->reaction,
                           &rod->shape.tangent,
                           &rod->shape.director,
                           &rod->shape.m1,
                           &rod->shape.m2,
                           &rod->shape.binormal,
                           &rod->gradient,
                           &rod->try_x,
                           &rod->best_x,
                           &rod->step_x,
                           &rod->predicted,
                           &rod->damping_tangent,
                           &rod->old_binormal};
    double **reals[] = {&rod->theta,
                        &rod->rest_length,
                        &rod->mass,
                        &rod->cell,
                        &rod->turn,
                        &rod->torque,
                        &rod->reaction_torque,
                        &rod->shape.length,
                        &rod->shape.chi,
                        &rod->shape.twist,
                        &rod->shape.reference,
                        &rod->matrix.turn,
                        &rod->matrix.turn_before,
                        &rod->turn_gradient,
                        &rod->try_theta,
                        &rod->best_theta,
                        &rod->step_theta,
                        &rod->saved_turns,
                        &rod->old_length,
                        &rod->grip,
                        &rod->grip_limit,
                        &rod->anchor,
                        &rod->shape.lag};
    ndli_m3 **matrices[] = {&rod->damping_before, &rod->damping_after, &rod->damping_weight};
    for (size_t i = 0; i < sizeof vectors / sizeof *vectors; i++)
        *vectors[i] = (ndli_v3 *)sbi_arena_take(arena, n, v);
    for (size_t i = 0; i < sizeof reals / sizeof *reals; i++)
        *reals[i] = (double *)sbi_arena_take(arena, n, d);
    for (size_t i = 0; i < sizeof matrices / sizeof *matrices; i++)
        *matrices[i] = (ndli_m3 *)sbi_arena_take(arena, n, m);
    rod->rest_bend = (double(*)[2])sbi_arena_take(arena, n, 2 * d);
    rod->old_bend = (double(*)[4])sbi_arena_take(arena, n, 4 * d);
    rod->matrix.node = (ndli_m3(*)[3])sbi_arena_take(arena, n, 3 * m);
    rod->matrix.cross = (ndli_v3(*)[4])sbi_arena_take(arena, n, 4 * v);
    rod->held = (unsigned char *)sbi_arena_take(arena, n, 1);
    rod->has_velocity = (unsigned char *)sbi_arena_take(arena, n, 1);
    rod->turn_held = (unsigned char *)sbi_arena_take(arena, n, 1);
    rod->public_x = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    rod->public_v = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    rod->public_reaction = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    rod->band = (double *)sbi_arena_take(arena, n, 4 * (NDLI_ROD_WIDTH + 1) * d);
    rod->unknown = (double *)sbi_arena_take(arena, n, 4 * d);
    rod->saved_nodes = (ndli_v3 *)sbi_arena_take(arena, n, NDLI_ROD_SAVED_NODES * v);
    rod->saved_reals = (double *)sbi_arena_take(arena, n, NDLI_ROD_SAVED_REALS * d);
}

static sb_result ndli_rod_allocate(const ndl_rod_def *def, ndl_rod **rod, sb_error *error)
{
    int nodes = def->capacity ? def->capacity : def->node_count;
    ndl_rod *made = (ndl_rod *)sbi_alloc_zeroed(&def->allocator, 1, sizeof(ndl_rod));
    sbi_arena arena = {NULL, 0, 0};
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a rod");
    made->allocator = def->allocator;
    ndli_rod_layout(made, &arena, nodes);
    made->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&def->allocator, 1, arena.used);
    if (!made->memory) {
        sbi_free(&def->allocator, made);
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a rod of %d nodes", nodes);
    }
    arena.base = (unsigned char *)made->memory;
    arena.used = 0;
    ndli_rod_layout(made, &arena, nodes);
    made->capacity = nodes;
    made->node_count = def->node_count;
    *rod = made;
    return SB_OK;
}

/* Edges, tangents and the Bishop frame from `director` on, of the first positions. */
static sb_result ndli_rod_first_shape(ndl_rod *rod, ndli_v3 director, sb_error *error)
{
    int bad;
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        ndli_v3 e = ndli_sub(rod->x[j + 1], rod->x[j]);
        double length = ndli_norm(e);
        if (!(length > 1e-12 * ndli_rod_reach(rod)) || !ndli_is_finite(length))
            return sbi_fail_node(error, SB_ERROR_MESH, j + 1, "nodes %d and %d are too close or too far", j, j + 1);
        rod->rest_length[j] = length;
        rod->tangent[j] = ndli_scale(1 / length, e);
        rod->director[j] = ndli_rod_across(j ? rod->director[j - 1] : director, rod->tangent[j]);
    }
    bad = ndli_rod_set_shape(rod, rod->x, rod->theta);
    if (bad >= 0)
        return sbi_fail_node(error, SB_ERROR_MESH, bad, "the rod turns back at node %d", bad);
    for (int j = 1; j < ndli_rod_edges(rod); j++)
        rod->director[j] = ndli_rod_across(
            ndli_rod_transport(rod->tangent[j - 1], rod->tangent[j], rod->director[j - 1]), rod->tangent[j]);
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    return SB_OK;
}

/* Integrated curvature 2 tan(k h/2) of an arc. */
NDLI_API void ndli_rod_bend_to(ndl_rod *rod, int i, double curvature1, double curvature2)
{
    double k = sqrt(curvature1 * curvature1 + curvature2 * curvature2), s, c, factor;
    sbi_dense_sin_cos(0.5 * k * rod->cell[i], &s, &c);
    factor = k > 0 ? 2 * s / (c * k) : 0;
    rod->rest_bend[i][0] = factor * curvature1;
    rod->rest_bend[i][1] = factor * curvature2;
}

static sb_result ndli_rod_set_rest_curvature(ndl_rod *rod, int i, const sb_real *given, sb_error *error)
{
    double k0 = (double)given[0], k1 = (double)given[1];
    if (!(sqrt(k0 * k0 + k1 * k1) * rod->cell[i] < 2.9))
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "the rest curvature of node %d turns the rod back", i);
    ndli_rod_bend_to(rod, i, k0, k1);
    return SB_OK;
}

static sb_result ndli_rod_set_rest(ndl_rod *rod, const ndl_rod_def *def, sb_error *error)
{
    rod->plain = rod->bending[0] == rod->bending[1];
    for (int i = 1; i < rod->node_count - 1; i++) {
        if (def->rest == NDL_REST_SHAPE) {
            rod->rest_bend[i][0] = ndli_dot(rod->shape.binormal[i], rod->shape.m2[i]);
            rod->rest_bend[i][1] = -ndli_dot(rod->shape.binormal[i], rod->shape.m1[i]);
        } else if (def->rest == NDL_REST_CURVATURE) {
            sb_result result = ndli_rod_set_rest_curvature(rod, i, def->rest_curvature + 2 * i, error);
            if (result != SB_OK)
                return result;
        }
        rod->plain = rod->plain && rod->rest_bend[i][0] == 0 && rod->rest_bend[i][1] == 0;
    }
    return SB_OK;
}

static sb_result ndli_rod_fill(ndl_rod *rod, const ndl_rod_def *def, const ndl_rod_stiffness *stiffness,
                               sb_error *error)
{
    sb_result result;
    rod->stretch = (double)stiffness->stretch;
    rod->bending[0] = (double)stiffness->bending[0];
    rod->bending[1] = (double)stiffness->bending[1];
    rod->torsion = (double)stiffness->twist;
    rod->line_density = (double)stiffness->line_density;
    rod->gravity = ndli_from(def->gravity);
    rod->damping_stretch = (double)def->damping_stretch;
    rod->damping_bending = (double)def->damping_bending;
    rod->max_newton = def->max_newton;
    rod->tolerance = (double)def->tolerance;
    for (int i = 0; i < rod->node_count; i++)
        rod->x[i] = ndli_from(def->nodes[i]);
    result = ndli_rod_first_shape(rod, ndli_from(def->director), error);
    for (int i = 0; def->clamped && i < 2; i++) {
        rod->held[i] = 1;
        rod->target[i] = rod->x[i];
    }
    rod->turn_held[0] = (unsigned char)def->clamped;
    if (result == SB_OK) {
        ndli_rod_rest_changed(rod);
        result = ndli_rod_set_rest(rod, def, error);
    }
    if (result == SB_OK) {
        ndli_rod_relax(rod);
        ndli_rod_publish(rod);
    }
    return result;
}

NDL_API sb_result ndl_rod_create(const ndl_rod_def *def, ndl_rod **rod, sb_error *error)
{
    ndl_rod_stiffness stiffness;
    ndl_rod *made = NULL;
    sb_result result;
    if (!def || !rod)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def or rod is NULL");
    memset(&stiffness, 0, sizeof stiffness);
    result = ndli_rod_check_def(def, error);
    if (result == SB_OK)
        result = ndli_rod_check_material(def, &stiffness, error);
    if (result == SB_OK)
        result = ndli_rod_allocate(def, &made, error);
    if (result == SB_OK)
        result = ndli_rod_fill(made, def, &stiffness, error);
    if (result == SB_OK)
        *rod = made;
    else
        ndl_rod_destroy(made);
    return result;
}

NDL_API void ndl_rod_destroy(ndl_rod *rod)
{
    sb_allocator allocator;
    if (!rod)
        return;
    allocator = rod->allocator;
    sbi_free(&allocator, rod->memory);
    sbi_free(&allocator, rod);
}

/* ---- state ---- */

NDLI_API void ndli_rod_publish(ndl_rod *rod)
{
    for (int i = 0; i < rod->node_count; i++) {
        rod->public_x[i] = ndli_to(rod->x[i]);
        rod->public_v[i] = ndli_to(rod->v[i]);
        rod->public_reaction[i] = ndli_to(rod->reaction[i]);
    }
}

/* Copies of the arrays that make the state, or back. */
static void ndli_rod_copy_state(ndl_rod *rod, int save)
{
    ndli_v3 *vectors[NDLI_ROD_SAVED_NODES];
    double *reals[NDLI_ROD_SAVED_REALS];
    size_t n = (size_t)rod->node_count;
    vectors[0] = rod->x, vectors[1] = rod->v, vectors[2] = rod->a;
    vectors[3] = rod->director, vectors[4] = rod->tangent, vectors[5] = rod->reaction;
    reals[0] = rod->theta, reals[1] = rod->reaction_torque, reals[2] = rod->anchor;
    for (size_t k = 0; k < NDLI_ROD_SAVED_NODES; k++)
        memcpy(save ? rod->saved_nodes + k * n : vectors[k], save ? vectors[k] : rod->saved_nodes + k * n,
               n * sizeof(ndli_v3));
    for (size_t k = 0; k < NDLI_ROD_SAVED_REALS; k++)
        memcpy(save ? rod->saved_reals + k * n : reals[k], save ? reals[k] : rod->saved_reals + k * n,
               n * sizeof(double));
}

NDLI_API void ndli_rod_save(ndl_rod *rod) { ndli_rod_copy_state(rod, 1); }
NDLI_API void ndli_rod_restore(ndl_rod *rod) { ndli_rod_copy_state(rod, 0); }

NDLI_API int ndli_rod_moved(ndl_rod *rod)
{
    int bad = ndli_rod_follow(rod);
    if (bad < 0)
        ndli_rod_slip(rod);
    return bad;
}

NDLI_API int ndli_rod_follow(ndl_rod *rod)
{
    int bad = ndli_rod_set_shape(rod, rod->x, rod->theta);
    double turned = 0;
    if (bad >= 0)
        return bad;
    rod->director[0] = ndli_rod_across(rod->shape.director[0], rod->shape.tangent[0]);
    rod->tangent[0] = rod->shape.tangent[0];
    for (int j = 1; j < ndli_rod_edges(rod); j++) {
        double before = rod->theta[j]; /* theta[j - 1] has turned already */
        turned += rod->shape.twist[j] - (before - (rod->theta[j - 1] - turned));
        rod->theta[j] = before + turned;
        rod->anchor[j] += turned;
        rod->tangent[j] = rod->shape.tangent[j];
        rod->director[j] = ndli_rod_across(
            ndli_rod_transport(rod->tangent[j - 1], rod->tangent[j], rod->director[j - 1]), rod->tangent[j]);
    }
    ndli_rod_relax(rod);
    return -1;
}

NDLI_API void ndli_rod_rest_changed(ndl_rod *rod)
{
    int n = rod->node_count;
    for (int i = 0; i < n; i++) {
        double before = i > 0 ? rod->rest_length[i - 1] : 0, after = i < n - 1 ? rod->rest_length[i] : 0;
        rod->cell[i] = 0.5 * (before + after);
        rod->mass[i] = rod->line_density * rod->cell[i];
    }
    if (n > 3 && rod->held[0] && rod->held[1]) /* half of node 1's cell lies in the clamp */
        rod->cell[1] = 0.5 * rod->rest_length[1];
    if (n > 3 && rod->held[n - 1] && rod->held[n - 2])
        rod->cell[n - 2] = 0.5 * rod->rest_length[n - 3];
}

/* ---- supports and loads ---- */

static int ndli_rod_has_node(const ndl_rod *rod, int node) { return node >= 0 && node < rod->node_count; }

/* Where a new support or load begins the energy may become another. */
static void ndli_rod_touched(ndl_rod *rod) { rod->energy_monitored = 0; }

static void ndli_rod_set_target(ndl_rod *rod, int node, ndli_v3 position, const ndli_v3 *velocity)
{
    rod->held[node] = 1;
    rod->target[node] = position;
    rod->has_velocity[node] = velocity != NULL;
    if (velocity)
        rod->target_velocity[node] = *velocity;
    ndli_rod_rest_changed(rod);
    ndli_rod_touched(rod);
}

NDL_API sb_result ndl_rod_hold(ndl_rod *rod, int node, sb_vec3 position, const sb_vec3 *velocity)
{
    ndli_v3 v = ndli_v(0, 0, 0);
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!ndli_rod_has_node(rod, node))
        return SB_ERROR_INDEX;
    if (!sb_v3_is_finite(position) || (velocity && !sb_v3_is_finite(*velocity)))
        return SB_ERROR_NOT_FINITE;
    if (velocity)
        v = ndli_from(*velocity);
    ndli_rod_set_target(rod, node, ndli_from(position), velocity ? &v : NULL);
    return SB_OK;
}

NDL_API sb_result ndl_rod_release(ndl_rod *rod, int node)
{
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!ndli_rod_has_node(rod, node))
        return SB_ERROR_INDEX;
    rod->held[node] = rod->has_velocity[node] = 0;
    if (node < 2)
        rod->base_director_set = 0;
    ndli_rod_rest_changed(rod);
    ndli_rod_touched(rod);
    return SB_OK;
}

NDL_API sb_result ndl_rod_turn(ndl_rod *rod, int edge, sb_real angle)
{
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!ndli_rod_has_edge(rod, edge))
        return SB_ERROR_INDEX;
    if (!sb_is_finite(angle))
        return SB_ERROR_NOT_FINITE;
    rod->turn_held[edge] = 1;
    rod->turn[edge] += (double)angle;
    ndli_rod_touched(rod);
    return SB_OK;
}

NDL_API sb_result ndl_rod_release_turn(ndl_rod *rod, int edge)
{
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!ndli_rod_has_edge(rod, edge))
        return SB_ERROR_INDEX;
    rod->turn_held[edge] = 0;
    rod->turn[edge] = 0;
    if (edge == 0)
        rod->base_director_set = 0;
    ndli_rod_touched(rod);
    return SB_OK;
}

NDL_API sb_result ndl_rod_hold_base(ndl_rod *rod, sb_vec3 position, sb_vec3 tangent, sb_vec3 director,
                                    const sb_vec3 *velocity, const sb_vec3 *angular_velocity)
{
    ndli_v3 t = ndli_from(tangent), x = ndli_from(position), d = ndli_from(director), v0, v1, axis;
    double size = ndli_norm(t);
    if (!rod || !velocity != !angular_velocity)
        return SB_ERROR_ARGUMENT;
    if (!sb_v3_is_finite(position) || !sb_v3_is_finite(tangent) || !sb_v3_is_finite(director) ||
        (velocity && (!sb_v3_is_finite(*velocity) || !sb_v3_is_finite(*angular_velocity))))
        return SB_ERROR_NOT_FINITE;
    if (!(size > 0) || !(ndli_norm(ndli_cross(t, d)) > 1e-6 * size * ndli_norm(d)))
        return SB_ERROR_ARGUMENT;
    t = ndli_scale(1 / size, t);
    axis = ndli_scale(rod->rest_length[0], t);
    v0 = v1 = ndli_v(0, 0, 0);
    if (velocity) {
        v0 = ndli_from(*velocity);
        v1 = ndli_add(v0, ndli_cross(ndli_from(*angular_velocity), axis));
    }
    ndli_rod_set_target(rod, 0, x, velocity ? &v0 : NULL);
    ndli_rod_set_target(rod, 1, ndli_add(x, axis), velocity ? &v1 : NULL);
    rod->turn_held[0] = 1;
    rod->turn[0] = 0;
    rod->base_director_set = 1;
    rod->base_director = ndli_rod_across(d, t);
    return SB_OK;
}

NDL_API sb_result ndl_rod_set_force(ndl_rod *rod, int node, sb_vec3 force)
{
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!ndli_rod_has_node(rod, node))
        return SB_ERROR_INDEX;
    if (!sb_v3_is_finite(force))
        return SB_ERROR_NOT_FINITE;
    rod->force[node] = ndli_from(force);
    ndli_rod_touched(rod);
    return SB_OK;
}

NDL_API sb_result ndl_rod_set_torque(ndl_rod *rod, int edge, sb_real torque)
{
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!ndli_rod_has_edge(rod, edge))
        return SB_ERROR_INDEX;
    if (!sb_is_finite(torque))
        return SB_ERROR_NOT_FINITE;
    rod->torque[edge] = (double)torque;
    ndli_rod_touched(rod);
    return SB_OK;
}

NDL_API sb_result ndl_rod_set_gravity(ndl_rod *rod, sb_vec3 gravity)
{
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!sb_v3_is_finite(gravity))
        return SB_ERROR_NOT_FINITE;
    rod->gravity = ndli_from(gravity);
    ndli_rod_touched(rod);
    return SB_OK;
}

NDL_API sb_result ndl_rod_set_damping(ndl_rod *rod, sb_real stretch, sb_real bending)
{
    if (!rod || !ndli_rod_not_negative(stretch) || !ndli_rod_not_negative(bending))
        return SB_ERROR_ARGUMENT;
    rod->damping_stretch = (double)stretch;
    rod->damping_bending = (double)bending;
    return SB_OK;
}

NDL_API sb_result ndl_rod_set_positions(ndl_rod *rod, const sb_vec3 *positions, sb_error *error)
{
    int bad;
    if (!rod || !positions)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "rod or positions is NULL");
    for (int i = 0; i < rod->node_count; i++)
        if (!sb_v3_is_finite(positions[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "node %d is not finite", i);
    ndli_rod_save(rod);
    for (int i = 0; i < rod->node_count; i++)
        rod->x[i] = ndli_from(positions[i]);
    bad = ndli_rod_moved(rod);
    if (bad >= 0) {
        ndli_rod_restore(rod);
        return sbi_fail_node(error, SB_ERROR_MESH, bad, "the rod has no length or turns back at node %d", bad);
    }
    for (int i = 0; i < rod->node_count; i++)
        if (rod->held[i])
            rod->target[i] = rod->x[i];
    memset(rod->a, 0, (size_t)rod->node_count * sizeof *rod->a);
    ndli_rod_touched(rod);
    ndli_rod_publish(rod);
    return SB_OK;
}

NDL_API sb_result ndl_rod_set_velocities(ndl_rod *rod, const sb_vec3 *velocities)
{
    if (!rod || !velocities)
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < rod->node_count; i++)
        if (!sb_v3_is_finite(velocities[i]))
            return SB_ERROR_NOT_FINITE;
    for (int i = 0; i < rod->node_count; i++)
        rod->v[i] = ndli_from(velocities[i]);
    ndli_rod_touched(rod);
    ndli_rod_publish(rod);
    return SB_OK;
}

/* ---- changing the number of nodes ---- */

/* Opens a place at `at` in an array of `count` things, or closes the one there. */
static void ndli_rod_shift(void *array, size_t size, int at, int count, int open)
{
    char *place = (char *)array + (size_t)at * size;
    size_t rest = (size_t)(count - at) * size;
    if (open)
        memmove(place + size, place, rest);
    else
        memmove(place, place + size, rest - size);
}

static void ndli_rod_shift_all(ndl_rod *rod, int node, int edge, int open)
{
    int n = rod->node_count;
    ndli_v3 *node_vectors[6], *edge_vectors[2];
    double *edge_reals[8];
    node_vectors[0] = rod->x, node_vectors[1] = rod->v, node_vectors[2] = rod->a, node_vectors[3] = rod->target;
    node_vectors[4] = rod->target_velocity, node_vectors[5] = rod->force;
    edge_vectors[0] = rod->director, edge_vectors[1] = rod->tangent;
    edge_reals[0] = rod->theta, edge_reals[1] = rod->rest_length, edge_reals[2] = rod->turn;
    edge_reals[3] = rod->torque, edge_reals[4] = rod->reaction_torque;
    edge_reals[5] = rod->grip, edge_reals[6] = rod->grip_limit, edge_reals[7] = rod->anchor;
    for (int k = 0; k < 6; k++)
        ndli_rod_shift(node_vectors[k], sizeof(ndli_v3), node, n, open);
    ndli_rod_shift(rod->reaction, sizeof(ndli_v3), node, n, open);
    ndli_rod_shift(rod->rest_bend, sizeof *rod->rest_bend, node, n, open);
    ndli_rod_shift(rod->held, 1, node, n, open);
    ndli_rod_shift(rod->has_velocity, 1, node, n, open);
    for (int k = 0; k < 2; k++)
        ndli_rod_shift(edge_vectors[k], sizeof(ndli_v3), edge, n - 1, open);
    for (int k = 0; k < 8; k++)
        ndli_rod_shift(edge_reals[k], sizeof(double), edge, n - 1, open);
    ndli_rod_shift(rod->turn_held, 1, edge, n - 1, open);
    rod->node_count += open ? 1 : -1;
}

/* Tangent at a node: that of the edges on both sides. */
static ndli_v3 ndli_rod_node_tangent(const ndl_rod *rod, int i)
{
    ndli_v3 before = rod->tangent[sbi_max_int(i - 1, 0)], after = rod->tangent[sbi_min_int(i, rod->node_count - 2)];
    ndli_v3 sum = ndli_add(before, after);
    return ndli_scale(1 / ndli_norm(sum), sum);
}

/* Rest curvature (1/m) of node i, or of its neighbour on the other side of the edge where i is an end. */
static void ndli_rod_rest_density(const ndl_rod *rod, int i, int other, double density[2])
{
    int from = i > 0 && i < rod->node_count - 1 ? i : other;
    int known = from > 0 && from < rod->node_count - 1;
    for (int k = 0; k < 2; k++)
        density[k] = known ? rod->rest_bend[from][k] / rod->cell[from] : 0;
}

static void ndli_rod_set_rest_density(ndl_rod *rod, int i, const double density[2])
{
    for (int k = 0; k < 2; k++)
        rod->rest_bend[i][k] = i > 0 && i < rod->node_count - 1 ? density[k] * rod->cell[i] : 0;
}

/* What holds or turns an edge stays at its outer half, when the edge is cut: towards the end that it is next to. */
static void ndli_rod_split_turn(ndl_rod *rod, int edge)
{
    int both = rod->held[edge] && rod->held[edge + 2], outer = edge > 0 && edge + 1 == ndli_rod_edges(rod) - 1;
    int inner_half = outer ? edge : edge + 1;
    if (!both) {
        rod->turn_held[inner_half] = 0;
        rod->turn[inner_half] = 0;
    }
    rod->torque[inner_half] = 0;
}

NDL_API sb_result ndl_rod_split_edge(ndl_rod *rod, int edge)
{
    ndli_v3 middle, bow;
    double densities[3][2];
    int straight;
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!ndli_rod_has_edge(rod, edge))
        return SB_ERROR_INDEX;
    if (rod->node_count == rod->capacity)
        return SB_ERROR_UNSUPPORTED;
    straight = rod->held[edge] && rod->held[edge + 1];
    middle = ndli_scale(0.5, ndli_add(rod->x[edge], rod->x[edge + 1]));
    bow = ndli_sub(ndli_rod_node_tangent(rod, edge), ndli_rod_node_tangent(rod, edge + 1));
    ndli_rod_rest_density(rod, edge, edge + 1, densities[0]);
    ndli_rod_rest_density(rod, edge + 1, edge, densities[2]);
    for (int k = 0; k < 2; k++)
        densities[1][k] = 0.5 * (densities[0][k] + densities[2][k]);
    if (!straight)
        middle = ndli_madd(middle, ndli_norm(ndli_sub(rod->x[edge + 1], rod->x[edge])) / 8, bow);
    ndli_rod_shift_all(rod, edge + 1, edge + 1, 1);
    rod->x[edge + 1] = middle;
    rod->v[edge + 1] = ndli_scale(0.5, ndli_add(rod->v[edge], rod->v[edge + 2]));
    rod->a[edge + 1] = ndli_scale(0.5, ndli_add(rod->a[edge], rod->a[edge + 2]));
    rod->target[edge + 1] = ndli_scale(0.5, ndli_add(rod->target[edge], rod->target[edge + 2]));
    rod->held[edge + 1] = (unsigned char)straight;
    rod->has_velocity[edge + 1] = 0;
    rod->force[edge + 1] = rod->reaction[edge + 1] = ndli_v(0, 0, 0);
    rod->tangent[edge + 1] = rod->tangent[edge];
    rod->director[edge + 1] = rod->director[edge];
    rod->theta[edge + 1] = rod->theta[edge];
    rod->turn_held[edge + 1] = rod->turn_held[edge];
    rod->turn[edge + 1] = rod->turn[edge];
    rod->torque[edge + 1] = rod->torque[edge];
    rod->reaction_torque[edge + 1] = 0;
    ndli_rod_split_grip(rod, edge);
    rod->rest_length[edge] *= 0.5;
    rod->rest_length[edge + 1] = rod->rest_length[edge];
    ndli_rod_split_turn(rod, edge);
    ndli_rod_rest_changed(rod);
    for (int k = 0; k < 3; k++)
        ndli_rod_set_rest_density(rod, edge + k, densities[k]);
    ndli_rod_moved(rod); /* the bow is too flat to fold the rod */
    ndli_rod_touched(rod);
    ndli_rod_publish(rod);
    return SB_OK;
}

/* Takes node i's share of what is conserved to its neighbours: `after` to the next, the rest to the one before. */
static void ndli_rod_share(ndl_rod *rod, int i, double after)
{
    int n = rod->node_count;
    double bend_after = i + 1 == n - 1 ? 0 : i - 1 == 0 ? 1 : after;
    double before_length = rod->rest_length[i - 1], after_length = rod->rest_length[i], light;
    ndli_v3 lost = ndli_scale(0.5 * (before_length + after_length), rod->v[i]);
    for (int k = 0; k < 2 && n > 3; k++) {
        rod->rest_bend[i - 1][k] += (1 - bend_after) * rod->rest_bend[i][k];
        rod->rest_bend[i + 1][k] += bend_after * rod->rest_bend[i][k];
    }
    rod->force[i - 1] = ndli_madd(rod->force[i - 1], 1 - after, rod->force[i]);
    rod->force[i + 1] = ndli_madd(rod->force[i + 1], after, rod->force[i]);
    lost = ndli_madd(ndli_madd(lost, -0.5 * after_length, rod->v[i - 1]), -0.5 * before_length, rod->v[i + 1]);
    light = (rod->held[i - 1] ? 0 : rod->mass[i - 1] / rod->line_density + 0.5 * after_length) +
            (rod->held[i + 1] ? 0 : rod->mass[i + 1] / rod->line_density + 0.5 * before_length);
    for (int k = i - 1; k <= i + 1; k += 2)
        if (!rod->held[k])
            rod->v[k] = ndli_madd(rod->v[k], 1 / light, lost);
}

NDL_API sb_result ndl_rod_merge_node(ndl_rod *rod, int node)
{
    double after, length, turn, lags[2];
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (!ndli_rod_has_node(rod, node))
        return SB_ERROR_INDEX;
    if (node == 0 || node == rod->node_count - 1 || rod->held[node])
        return SB_ERROR_UNSUPPORTED;
    length = rod->rest_length[node - 1] + rod->rest_length[node];
    after = rod->rest_length[node - 1] / length;
    turn = (1 - after) * (rod->theta[node] - rod->theta[node - 1]);
    /* a rod that a merged edge would fold keeps its node */
    if (!(1 + ndli_dot(rod->tangent[node - 1], rod->tangent[node]) > 1))
        return SB_ERROR_UNSUPPORTED;
    for (int k = 0; k < 2; k++)
        lags[k] = rod->theta[node - 1 + k] - rod->anchor[node - 1 + k];
    ndli_rod_share(rod, node, after);
    rod->theta[node - 1] += rod->turn_held[node - 1] ? 0 : turn;
    rod->rest_length[node] = length;
    rod->turn_held[node] |= rod->turn_held[node - 1];
    rod->turn[node] += rod->turn[node - 1];
    rod->torque[node] += rod->torque[node - 1];
    rod->theta[node] = rod->theta[node - 1];
    ndli_rod_merge_grip(rod, node - 1, node, lags);
    rod->tangent[node] = rod->tangent[node - 1];
    rod->director[node] = rod->director[node - 1];
    ndli_rod_shift_all(rod, node, node - 1, 0);
    ndli_rod_rest_changed(rod);
    ndli_rod_moved(rod);
    ndli_rod_touched(rod);
    ndli_rod_publish(rod);
    return SB_OK;
}

NDL_API sb_result ndl_rod_feed(ndl_rod *rod, sb_real length)
{
    double densities[2][2], now;
    if (!rod || rod->node_count < 3)
        return SB_ERROR_ARGUMENT;
    if (!sb_is_finite(length))
        return SB_ERROR_NOT_FINITE;
    now = rod->rest_length[1] + (double)length;
    if (!(now > 1e-3 * rod->rest_length[0]) || !(ndli_norm(ndli_sub(rod->x[2], rod->x[1])) > 2e-3 * now))
        return SB_ERROR_ARGUMENT;
    ndli_rod_rest_density(rod, 1, 2, densities[0]);
    ndli_rod_rest_density(rod, 2, 1, densities[1]);
    rod->rest_length[1] = now;
    ndli_rod_rest_changed(rod);
    for (int k = 0; k < 2; k++)
        ndli_rod_set_rest_density(rod, 1 + k, densities[k]);
    ndli_rod_relax(rod);
    ndli_rod_slip(rod);
    ndli_rod_touched(rod);
    return SB_OK;
}

/* ---- readings ---- */

NDL_API int ndl_rod_node_count(const ndl_rod *rod) { return rod ? rod->node_count : 0; }
NDL_API const sb_vec3 *ndl_rod_positions(const ndl_rod *rod) { return rod ? rod->public_x : NULL; }
NDL_API const sb_vec3 *ndl_rod_velocities(const ndl_rod *rod) { return rod ? rod->public_v : NULL; }
NDL_API const sb_vec3 *ndl_rod_reactions(const ndl_rod *rod) { return rod ? rod->public_reaction : NULL; }
NDL_API sb_real ndl_rod_mass(const ndl_rod *rod, int node)
{
    return rod && node >= 0 && node < rod->node_count ? (sb_real)rod->mass[node] : 0;
}
NDL_API sb_real ndl_rod_rest_length(const ndl_rod *rod, int edge)
{
    return ndli_rod_has_edge(rod, edge) ? (sb_real)rod->rest_length[edge] : 0;
}
NDL_API sb_real ndl_rod_reaction_torque(const ndl_rod *rod, int edge)
{
    return ndli_rod_has_edge(rod, edge) ? (sb_real)rod->reaction_torque[edge] : 0;
}

NDL_API ndl_frame ndl_rod_frame(const ndl_rod *rod, int edge)
{
    ndl_frame frame;
    ndli_v3 t, d, across;
    double s, c;
    memset(&frame, 0, sizeof frame);
    if (!ndli_rod_has_edge(rod, edge))
        return frame;
    t = rod->tangent[edge], d = rod->director[edge], across = ndli_cross(t, d);
    sbi_dense_sin_cos(rod->theta[edge], &s, &c);
    frame.m1 = ndli_to(ndli_madd(ndli_scale(c, d), s, across));
    frame.m2 = ndli_to(ndli_madd(ndli_scale(-s, d), c, across));
    frame.t = ndli_to(t);
    return frame;
}

NDL_API void ndl_rod_tip(const ndl_rod *rod, sb_vec3 *position, ndl_frame *frame)
{
    if (!rod)
        return;
    if (position)
        *position = rod->public_x[rod->node_count - 1];
    if (frame)
        *frame = ndl_rod_frame(rod, rod->node_count - 2);
}

NDL_API void ndl_rod_curvature(const ndl_rod *rod, int node, sb_real curvature[2])
{
    double w[2];
    if (!ndli_rod_is_inner(rod, node) || !curvature)
        return;
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    w[0] = ndli_dot(rod->shape.binormal[node], ndli_add(rod->shape.m2[node - 1], rod->shape.m2[node]));
    w[1] = -ndli_dot(rod->shape.binormal[node], ndli_add(rod->shape.m1[node - 1], rod->shape.m1[node]));
    for (int k = 0; k < 2; k++)
        curvature[k] = (sb_real)(0.5 * w[k] / rod->cell[node]);
}

NDL_API sb_real ndl_rod_twist(const ndl_rod *rod, int node)
{
    return ndli_rod_is_inner(rod, node) ? (sb_real)(rod->theta[node] - rod->theta[node - 1]) : 0;
}

NDL_API ndl_rod_energy ndl_rod_energies(const ndl_rod *rod)
{
    ndl_rod_energy none;
    ndl_rod_energy energy;
    ndli_rod_sums sums;
    double kinetic = 0;
    if (!rod) {
        memset(&none, 0, sizeof none);
        return none;
    }
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    sums = ndli_rod_shape_energy(rod);
    for (int i = 0; i < rod->node_count; i++)
        kinetic += 0.5 * rod->mass[i] * ndli_dot(rod->v[i], rod->v[i]);
    energy.stretch = (sb_real)sums.stretch;
    energy.bend = (sb_real)sums.bend;
    energy.twist = (sb_real)sums.twist;
    energy.kinetic = (sb_real)kinetic;
    energy.grip = (sb_real)sums.grip;
    return energy;
}

NDL_API void ndl_rod_forces(ndl_rod *rod, sb_vec3 *forces)
{
    if (!rod || !forces)
        return;
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    ndli_rod_derivatives(rod, 0, rod->gradient, rod->turn_gradient, NULL);
    ndli_rod_set_damping_shape(rod);
    ndli_rod_add_damping_force(rod, rod->v, rod->gradient);
    for (int i = 0; i < rod->node_count; i++)
        forces[i] = ndli_to(ndli_scale(-1, rod->gradient[i]));
}

NDL_API void ndl_rod_base_wrench(const ndl_rod *rod, sb_vec3 *force, sb_vec3 *torque)
{
    ndli_v3 moment;
    if (!rod)
        return;
    moment = ndli_cross(ndli_sub(rod->x[1], rod->x[0]), rod->reaction[1]);
    if (force)
        *force = ndli_to(ndli_add(rod->reaction[0], rod->reaction[1]));
    if (torque)
        *torque = ndli_to(ndli_madd(moment, rod->reaction_torque[0], rod->tangent[0]));
}

/* ==== src/needle/rod_step.c ==== */
/* rod_step: minimises a rod's potential over nodes and frames: a time step, a static solve.
 *
 * Positions x' of a step minimise
 *     1/2 inertia |x' - predicted|^2_M + E(x', theta') - loads.(x' - x) - torques.theta' + dissipation
 * with inertia = 1/(beta dt^2) and the dissipation of ndli_rod_set_viscous; without both that is the static
 * potential. */

typedef struct ndli_rod_problem {
    double inertia; /* 1/s^2: d a'/d x'; 0: statics */
    int max_newton;
    double tolerance;
} ndli_rod_problem;

/* A state of the minimisation. */
typedef struct ndli_rod_progress {
    double potential, noise; /* J */
    double residual, scale;  /* N: largest of what is left, of what is at work */
    double floor;            /* N: what rounding of positions leaves */
} ndli_rod_progress;

/* ---- potential of a step or solve, and its derivatives, in the shape that is tried ---- */

static ndli_v3 ndli_rod_load(const ndl_rod *rod, int i) { return ndli_madd(rod->force[i], rod->mass[i], rod->gravity); }

/* Of rod->shape, made from try_x and try_theta. */
static ndli_rod_progress ndli_rod_potential(ndl_rod *rod, const ndli_rod_problem *problem)
{
    ndli_rod_sums sums = ndli_rod_shape_energy(rod);
    ndli_rod_progress progress = {0, 0, 0, 0, 0};
    double sizes = 0;
    progress.potential = sums.stretch + sums.bend + sums.twist + sums.grip + sums.viscous;
    for (int i = 0; i < rod->node_count; i++) {
        ndli_v3 gap = ndli_sub(rod->try_x[i], rod->predicted[i]);
        double work = ndli_dot(ndli_rod_load(rod, i), ndli_sub(rod->try_x[i], rod->x[i])), inertia = 0;
        if (!rod->held[i])
            inertia = 0.5 * problem->inertia * rod->mass[i] * ndli_dot(gap, gap);
        progress.potential += inertia - work;
        sizes += inertia + fabs(work);
    }
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        progress.potential -= rod->torque[j] * rod->try_theta[j];
        sizes += fabs(rod->torque[j] * rod->try_theta[j]);
    }
    progress.noise = sums.noise + 4.5e-15 * sizes;
    return progress;
}

/* gradient and turn_gradient of the whole potential, matrix (NULL: not wanted) of its elastic part, and what is out of
 * balance. */
static void ndli_rod_balance(ndl_rod *rod, const ndli_rod_problem *problem, int flags, ndli_rod_matrix *matrix,
                             ndli_rod_progress *progress)
{
    int any_held = ndli_rod_any_turn_held(rod);
    double rounding = 4.5e-16 * rod->stretch * (1 + rod->viscous_stretch) * ndli_rod_reach(rod);
    ndli_rod_derivatives(rod, flags, rod->gradient, rod->turn_gradient, matrix);
    progress->residual = progress->scale = progress->floor = 0;
    for (int i = 0; i < rod->node_count; i++) {
        ndli_v3 load = ndli_rod_load(rod, i), inertia = ndli_v(0, 0, 0);
        if (!rod->held[i])
            inertia = ndli_scale(problem->inertia * rod->mass[i], ndli_sub(rod->try_x[i], rod->predicted[i]));
        progress->scale = fmax(progress->scale, ndli_norm(load));
        progress->scale = fmax(progress->scale, ndli_norm(inertia));
        progress->scale = fmax(progress->scale, ndli_norm(rod->gradient[i]));
        rod->gradient[i] = ndli_add(rod->gradient[i], ndli_sub(inertia, load));
        if (!rod->held[i])
            progress->residual = fmax(progress->residual, ndli_norm(rod->gradient[i]));
    }
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        double per_length = 1 / rod->rest_length[j];
        progress->scale = fmax(progress->scale, fabs(rod->turn_gradient[j]) * per_length);
        progress->scale = fmax(progress->scale, fabs(ndli_rod_grip_moment(rod, j, rod->shape.lag[j])) * per_length);
        rod->turn_gradient[j] -= rod->torque[j];
        if (!ndli_rod_turn_known(rod, j, any_held))
            progress->residual = fmax(progress->residual, fabs(rod->turn_gradient[j]) * per_length);
        progress->floor = fmax(progress->floor, rounding * per_length);
    }
    progress->floor += 4.5e-16 * progress->scale;
}

/* ---- the linear system ---- */

static double *ndli_rod_band_at(ndl_rod *rod, int row, int column)
{
    return rod->band + row * (NDLI_ROD_WIDTH + 1) + NDLI_ROD_WIDTH + column - row;
}

/* unknown -= K moves, for the lower half in rod->matrix and moves step_x. */
static void ndli_rod_subtract_moves(ndl_rod *rod)
{
    for (int i = 0; i < rod->node_count; i++)
        for (int k = 0; k < 3 && k <= i; k++) {
            const ndli_m3 *block = &rod->matrix.node[i][k];
            ndli_v3 down = ndli_m_apply(block, rod->step_x[i - k]), up = ndli_m_tapply(block, rod->step_x[i]);
            for (int c = 0; c < 3; c++) {
                rod->unknown[4 * i + c] -= ndli_component(down, c);
                if (k > 0)
                    rod->unknown[4 * (i - k) + c] -= ndli_component(up, c);
            }
        }
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        for (int k = 0; k < 4; k++)
            if (j - 1 + k >= 0 && j - 1 + k < rod->node_count)
                rod->unknown[4 * j + 3] -= ndli_dot(rod->matrix.cross[j][k], rod->step_x[j - 1 + k]);
}

/* Right-hand side: minus the gradient, less what the moves of held nodes (in step_x) already bring. */
static void ndli_rod_set_right_side(ndl_rod *rod)
{
    for (int i = 0; i < rod->node_count; i++) {
        for (int c = 0; c < 3; c++)
            rod->unknown[4 * i + c] = -ndli_component(rod->gradient[i], c);
        rod->unknown[4 * i + 3] = i < ndli_rod_edges(rod) ? -rod->turn_gradient[i] : 0;
    }
    ndli_rod_subtract_moves(rod);
}

static void ndli_rod_fill_band(ndl_rod *rod)
{
    memset(rod->band, 0, 4 * (size_t)rod->node_count * (NDLI_ROD_WIDTH + 1) * sizeof *rod->band);
    for (int i = 0; i < rod->node_count; i++)
        for (int k = 0; k < 3 && k <= i; k++)
            for (int r = 0; r < 3; r++)
                for (int c = 0; c < (k ? 3 : r + 1); c++)
                    *ndli_rod_band_at(rod, 4 * i + r, 4 * (i - k) + c) = rod->matrix.node[i][k].m[r][c];
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        for (int k = 0; k < 4; k++)
            for (int c = 0; c < 3; c++) {
                int node = 4 * (j - 1 + k) + c, turn = 4 * j + 3;
                if (node >= 0 && node < 4 * rod->node_count)
                    *ndli_rod_band_at(rod, sbi_max_int(node, turn), sbi_min_int(node, turn)) =
                        ndli_component(rod->matrix.cross[j][k], c);
            }
        *ndli_rod_band_at(rod, 4 * j + 3, 4 * j + 3) = rod->matrix.turn[j] + ndli_rod_turn_floor(rod, j);
        if (j > 0)
            *ndli_rod_band_at(rod, 4 * j + 3, 4 * j - 1) = rod->matrix.turn_before[j];
    }
}

/* Rows and columns of what is no unknown become those of the identity; the diagonal grows by the share `shift`. */
static void ndli_rod_pin_band(ndl_rod *rod, double shift)
{
    int n = 4 * rod->node_count, any_held = ndli_rod_any_turn_held(rod);
    for (int row = 0; row < n; row++) {
        int i = row / 4;
        int known = row % 4 < 3 ? rod->held[i] : i == ndli_rod_edges(rod) || ndli_rod_turn_known(rod, i, any_held);
        *ndli_rod_band_at(rod, row, row) *= 1 + shift;
        if (!known)
            continue;
        for (int other = sbi_max_int(0, row - NDLI_ROD_WIDTH); other <= sbi_min_int(n - 1, row + NDLI_ROD_WIDTH);
             other++)
            *ndli_rod_band_at(rod, sbi_max_int(row, other), sbi_min_int(row, other)) = 0;
        *ndli_rod_band_at(rod, row, row) = 1;
        rod->unknown[row] = 0;
    }
}

/* step_x, step_theta = the Newton step, held nodes to their targets. 0: the matrix is not positive definite. */
static int ndli_rod_solve_step(ndl_rod *rod, const ndli_rod_problem *problem, double shift)
{
    for (int i = 0; i < rod->node_count; i++)
        rod->step_x[i] = rod->held[i] ? ndli_sub(rod->predicted[i], rod->try_x[i]) : ndli_v(0, 0, 0);
    ndli_rod_set_right_side(rod);
    for (int i = 0; i < rod->node_count; i++)
        ndli_m_add_identity(&rod->matrix.node[i][0], problem->inertia * rod->mass[i]);
    ndli_rod_fill_band(rod);
    ndli_rod_pin_band(rod, shift);
    if (ndli_band_factor(rod->band, 4 * rod->node_count, NDLI_ROD_WIDTH, 1e-15) >= 0)
        return 0;
    ndli_band_solve(rod->band, 4 * rod->node_count, NDLI_ROD_WIDTH, rod->unknown);
    for (int i = 0; i < rod->node_count; i++) {
        const double *u = rod->unknown + 4 * i;
        if (!rod->held[i])
            rod->step_x[i] = ndli_v(u[0], u[1], u[2]);
        rod->step_theta[i] = u[3];
        if (!ndli_is_finite(ndli_norm(rod->step_x[i])) || !ndli_is_finite(u[3]))
            return 0;
    }
    return 1;
}

/* ---- a Newton step, taken ---- */

/* The edge j after the step of this size: turned by its part across, made longer by its part along. */
static ndli_v3 ndli_rod_turned_edge(const ndl_rod *rod, int j, double size)
{
    ndli_v3 e = ndli_sub(rod->best_x[j + 1], rod->best_x[j]), t, moved;
    ndli_v3 change = ndli_scale(size, ndli_sub(rod->step_x[j + 1], rod->step_x[j]));
    double l = ndli_norm(e), along;
    t = ndli_scale(1 / l, e);
    along = ndli_dot(t, change);
    moved = ndli_madd(ndli_add(e, change), -along, t);
    return ndli_scale((l + along) / ndli_norm(moved), moved);
}

/* Nodes from `first`, which is in place, to `last`: edges turned one after the other; what then is missing at a held
 * last node goes to all in between by their distance. */
static void ndli_rod_lay_edges(ndl_rod *rod, double size, int first, int last, int held)
{
    ndli_v3 end = ndli_madd(rod->best_x[last], size, rod->step_x[last]), missing;
    double whole = 0, passed = 0;
    for (int j = first; j < last; j++) {
        rod->try_x[j + 1] = ndli_add(rod->try_x[j], ndli_rod_turned_edge(rod, j, size));
        whole += rod->rest_length[j];
    }
    if (!held)
        return;
    missing = ndli_sub(end, rod->try_x[last]);
    for (int j = first; j < last; j++) {
        passed += rod->rest_length[j];
        rod->try_x[j + 1] = ndli_madd(rod->try_x[j + 1], passed / whole, missing);
    }
    rod->try_x[last] = end;
}

/* try_x, try_theta = best and `size` steps. A chain turns its edges: along straight lines they would stretch, and a
 * needle's stiffness against that would forbid all but tiny steps. */
static void ndli_rod_take(ndl_rod *rod, const ndli_rod_problem *problem, double size)
{
    int n = rod->node_count, first = 0, at;
    for (int j = 0; j < n - 1; j++)
        rod->try_theta[j] = rod->best_theta[j] + size * rod->step_theta[j];
    for (int i = 0; i < n; i++)
        rod->try_x[i] = ndli_madd(rod->best_x[i], size, rod->step_x[i]);
    if (problem->max_newton == 1)
        return;
    while (first < n && !rod->held[first])
        first++;
    first = first == n ? 0 : first;
    for (int j = first - 1; j >= 0; j--)
        rod->try_x[j] = ndli_sub(rod->try_x[j + 1], ndli_rod_turned_edge(rod, j, size));
    at = first;
    for (int i = first + 1; i < n; i++)
        if (rod->held[i] || i == n - 1) {
            ndli_rod_lay_edges(rod, size, at, i, rod->held[i]);
            at = i;
        }
}

/* The largest part of the step that turns no edge by more than about a radian. */
static double ndli_rod_largest_size(const ndl_rod *rod)
{
    double largest = 1;
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        double change = ndli_norm(ndli_sub(rod->step_x[j + 1], rod->step_x[j]));
        double length = ndli_norm(ndli_sub(rod->best_x[j + 1], rod->best_x[j]));
        if (change * largest > length)
            largest = length / change;
    }
    return largest;
}

static double ndli_rod_slope(const ndl_rod *rod)
{
    double slope = 0;
    for (int i = 0; i < rod->node_count; i++)
        if (!rod->held[i])
            slope += ndli_dot(rod->gradient[i], rod->step_x[i]);
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        slope += rod->turn_gradient[j] * rod->step_theta[j];
    return slope;
}

/* Whether held nodes still have some way to go; then the potential may rise, by their work. */
static int ndli_rod_supports_move(const ndl_rod *rod)
{
    for (int i = 0; i < rod->node_count; i++)
        if (rod->held[i] && ndli_norm(ndli_sub(rod->predicted[i], rod->try_x[i])) > 0)
            return 1;
    return 0;
}

/* Halves the step until it is possible and the potential falls. try_x, try_theta and rod->shape are there then, and
 * progress has its potential; 0: no such step. */
static int ndli_rod_search(ndl_rod *rod, const ndli_rod_problem *problem, int free_to_rise, double slope,
                           ndli_rod_progress *progress)
{
    double size = problem->max_newton == 1 ? 1 : ndli_rod_largest_size(rod);
    for (int halving = 0; halving < 40; halving++, size *= 0.5) {
        ndli_rod_progress next;
        ndli_rod_take(rod, problem, size);
        if (size == 1)
            for (int i = 0; i < rod->node_count; i++)
                if (rod->held[i])
                    rod->try_x[i] = rod->predicted[i]; /* to the last bit */
        if (ndli_rod_set_shape(rod, rod->try_x, rod->try_theta) >= 0)
            continue;
        next = ndli_rod_potential(rod, problem);
        if (problem->max_newton == 1 || free_to_rise ||
            next.potential <= progress->potential + 1e-4 * size * slope + next.noise) {
            *progress = next;
            return 1;
        }
    }
    return 0;
}

/* From now on frames are carried from rod->shape: an edge may then turn by any angle in the iterations of a step. */
static void ndli_rod_carry_frames(ndl_rod *rod)
{
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        rod->tangent[j] = rod->shape.tangent[j];
        rod->director[j] = ndli_rod_across(rod->shape.director[j], rod->shape.tangent[j]);
    }
}

/* The step of a matrix that is not positive definite, at rest: its diagonal grows by the least share, within a factor
 * of two, that makes it so. Near buckling one eigenvalue is about 0, next to nothing beside the diagonal, which
 * stretching has: with more the rod would creep along that motion. 0: no share does. */
static int ndli_rod_solve_shifted(ndl_rod *rod, const ndli_rod_problem *problem)
{
    const double least = 1e-13, most = 0.1; /* from rounding of the diagonal to what changes all of it */
    double shift = least;
    int solved;
    while (!(solved = ndli_rod_solve_step(rod, problem, shift)) && shift < most)
        shift *= 16;
    for (double factor = 4; solved && factor > 1.5 && shift > least; factor = sqrt(factor))
        if (ndli_rod_solve_step(rod, problem, shift / factor))
            shift /= factor;
        else
            solved = ndli_rod_solve_step(rod, problem, shift);
    return solved;
}

/* The ways to a step, in their order. */
typedef enum ndli_rod_way {
    NDLI_ROD_NEWTON,  /* the exact Hessian */
    NDLI_ROD_SHIFTED, /* the same made positive definite, at rest; in time the inertia does that */
    NDLI_ROD_GAUSS,   /* Gauss-Newton, and with larger diagonals */
    NDLI_ROD_GAUSS_MORE,
    NDLI_ROD_GAUSS_MOST,
    NDLI_ROD_WAYS
} ndli_rod_way;

static int ndli_rod_solve_way(ndl_rod *rod, const ndli_rod_problem *problem, ndli_rod_way way)
{
    static const double shifts[NDLI_ROD_WAYS] = {0, 0, 0, 1e-10, 1e-5};
    ndli_rod_progress again;
    ndli_rod_balance(rod, problem, way <= NDLI_ROD_SHIFTED ? NDLI_ROD_EXACT : 0, &rod->matrix, &again);
    if (way == NDLI_ROD_SHIFTED)
        return ndli_rod_solve_shifted(rod, problem);
    return ndli_rod_solve_step(rod, problem, shifts[way]);
}

/* try_x, try_theta and rod->shape of where the iteration began. */
static void ndli_rod_begin_again(ndl_rod *rod)
{
    memcpy(rod->try_x, rod->best_x, (size_t)rod->node_count * sizeof *rod->best_x);
    memcpy(rod->try_theta, rod->best_theta, (size_t)rod->node_count * sizeof *rod->best_theta);
    ndli_rod_set_shape(rod, rod->try_x, rod->try_theta);
}

/* Goes one way, if its matrix is positive definite and its step leads down; try_x, try_theta, rod->shape and progress
 * are then of where it led. */
static int ndli_rod_go(ndl_rod *rod, const ndli_rod_problem *problem, ndli_rod_way way, ndli_rod_progress *progress)
{
    int moving = ndli_rod_supports_move(rod);
    double slope;
    if (!ndli_rod_solve_way(rod, problem, way))
        return 0;
    slope = ndli_rod_slope(rod);
    return (moving || slope < 0) && ndli_rod_search(rod, problem, moving, slope, progress);
}

/* At rest, where the exact Hessian is not positive definite: the same made so leads along the motion in which the rod
 * buckles, Gauss-Newton to a rod that has buckled far. The one that leads farther down is taken. */
static int ndli_rod_go_lower(ndl_rod *rod, const ndli_rod_problem *problem, ndli_rod_progress *progress)
{
    ndli_rod_progress shifted = *progress, gauss = *progress;
    int first = ndli_rod_go(rod, problem, NDLI_ROD_SHIFTED, &shifted), second;
    ndli_rod_begin_again(rod);
    second = ndli_rod_go(rod, problem, NDLI_ROD_GAUSS, &gauss);
    if (second && !(first && shifted.potential < gauss.potential)) {
        *progress = gauss;
        return 1;
    }
    ndli_rod_begin_again(rod);
    return first && ndli_rod_go(rod, problem, NDLI_ROD_SHIFTED, progress);
}

/* One iteration from try_x, try_theta, which rod->shape is made from, by the first way that leads down. 0: none does;
 * all is as before. */
static int ndli_rod_iterate(ndl_rod *rod, const ndli_rod_problem *problem, ndli_rod_progress *progress)
{
    memcpy(rod->best_x, rod->try_x, (size_t)rod->node_count * sizeof *rod->best_x);
    memcpy(rod->best_theta, rod->try_theta, (size_t)rod->node_count * sizeof *rod->best_theta);
    if (problem->max_newton > 1 && ndli_rod_go(rod, problem, NDLI_ROD_NEWTON, progress))
        return 1;
    if (problem->max_newton > 1)
        ndli_rod_begin_again(rod);
    if (problem->inertia == 0 && ndli_rod_go_lower(rod, problem, progress))
        return 1;
    for (int way = problem->inertia == 0 ? NDLI_ROD_GAUSS_MORE : NDLI_ROD_GAUSS; way < NDLI_ROD_WAYS; way++) {
        if (way > NDLI_ROD_GAUSS)
            ndli_rod_begin_again(rod);
        if (ndli_rod_go(rod, problem, (ndli_rod_way)way, progress))
            return 1;
    }
    ndli_rod_begin_again(rod);
    return 0;
}

/* From try_x and try_theta to where the potential is least; predicted says where held nodes go. SB_OK also when
 * capped. */
static sb_result ndli_rod_minimise(ndl_rod *rod, const ndli_rod_problem *problem, ndl_rod_info *info)
{
    ndli_rod_progress progress;
    if (ndli_rod_set_shape(rod, rod->try_x, rod->try_theta) >= 0)
        return SB_ERROR_DIVERGED;
    progress = ndli_rod_potential(rod, problem);
    info->capped = 0;
    for (int iteration = 0;; iteration++) {
        ndli_rod_progress now;
        int moving = ndli_rod_supports_move(rod);
        ndli_rod_balance(rod, problem, 0, NULL, &now);
        info->residual = (sb_real)(now.scale > 0 ? now.residual / now.scale : 0);
        if (!ndli_is_finite(now.residual))
            return SB_ERROR_DIVERGED;
        if (!moving && now.residual <= problem->tolerance * now.scale + now.floor)
            return SB_OK;
        if (iteration == problem->max_newton) {
            info->capped = 1;
            return moving ? SB_ERROR_DIVERGED : SB_OK;
        }
        if (!ndli_rod_iterate(rod, problem, &progress))
            return now.residual <= 1e3 * now.floor ? SB_OK : SB_ERROR_DIVERGED;
        ndli_rod_carry_frames(rod);
        info->newton_iterations++;
    }
}

/* ---- common to steps and static solves ---- */

static sb_result ndli_rod_fail(ndl_rod_info *info, sb_result result, const char *message)
{
    return sbi_fail(&info->error, result, "%s", message);
}

/* try_theta = theta with `share` of the turns that are due, the base's director for nodes held at `predicted`. */
static void ndli_rod_set_turns(ndl_rod *rod, double share)
{
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        rod->try_theta[j] = rod->theta[j] + share * rod->turn[j];
    if (rod->base_director_set) {
        ndli_v3 e = ndli_sub(rod->target[1], rod->target[0]), t = ndli_scale(1 / ndli_norm(e), e), d, m1, wanted;
        double s, c;
        d = ndli_rod_transport(rod->tangent[0], t, rod->director[0]);
        sbi_dense_sin_cos(rod->theta[0], &s, &c);
        m1 = ndli_madd(ndli_scale(c, d), s, ndli_cross(t, d));
        wanted = rod->base_director;
        rod->try_theta[0] += share * sbi_dense_atan2(ndli_dot(ndli_cross(m1, wanted), t), ndli_dot(m1, wanted));
    }
}

static void ndli_rod_clear_turns(ndl_rod *rod)
{
    memset(rod->turn, 0, (size_t)rod->node_count * sizeof *rod->turn);
    rod->base_director_set = 0;
}

static int ndli_rod_any(const unsigned char *flags, int count)
{
    for (int i = 0; i < count; i++)
        if (flags[i])
            return 1;
    return 0;
}

static int ndli_rod_any_torque(const ndl_rod *rod)
{
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        if (rod->torque[j] != 0)
            return 1;
    return 0;
}

/* What the supports exert, from the state. */
static void ndli_rod_read_reactions(ndl_rod *rod)
{
    ndli_rod_derivatives(rod, 0, rod->gradient, rod->turn_gradient, NULL);
    for (int i = 0; i < rod->node_count; i++) {
        ndli_v3 force = ndli_sub(rod->gradient[i], ndli_rod_load(rod, i));
        rod->reaction[i] = rod->held[i] ? ndli_madd(force, rod->mass[i], rod->a[i]) : ndli_v(0, 0, 0);
    }
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        rod->reaction_torque[j] = rod->turn_held[j] ? rod->turn_gradient[j] - rod->torque[j] : 0;
}

/* ---- time step ---- */

/* Energy (J) of the state, loads' potential included; *lively: what of it is motion and strain. */
static double ndli_rod_total_energy(ndl_rod *rod, double *lively)
{
    ndli_rod_sums sums;
    double energy;
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    sums = ndli_rod_shape_energy(rod);
    energy = sums.stretch + sums.bend + sums.twist + sums.grip;
    for (int i = 0; i < rod->node_count; i++)
        energy += 0.5 * rod->mass[i] * ndli_dot(rod->v[i], rod->v[i]);
    *lively = energy;
    for (int i = 0; i < rod->node_count; i++)
        energy -= ndli_dot(ndli_rod_load(rod, i), rod->x[i]);
    return energy;
}

/* Takes from the new accelerations of a rod that nothing holds, as a whole, what the loads do not account for: what
 * Newton leaves out of balance would add up over the steps. */
static void ndli_rod_keep_momentum(ndl_rod *rod, const ndli_rod_problem *problem, double gamma_dt)
{
    ndli_v3 defect = ndli_v(0, 0, 0);
    double mass = 0;
    if (ndli_rod_any(rod->held, rod->node_count))
        return;
    for (int i = 0; i < rod->node_count; i++) {
        defect = ndli_add(defect, ndli_madd(ndli_rod_load(rod, i), -rod->mass[i], rod->a[i]));
        mass += rod->mass[i];
    }
    defect = ndli_scale(1 / mass, defect);
    for (int i = 0; i < rod->node_count; i++) {
        rod->a[i] = ndli_add(rod->a[i], defect);
        rod->v[i] = ndli_madd(rod->v[i], gamma_dt, defect);
        rod->x[i] = ndli_madd(rod->x[i], 1 / problem->inertia, defect);
    }
}

/* Newmark with beta = 1/4, gamma = 1/2; or implicit Euler, which is beta = gamma = 1 without the old acceleration. */
static sb_result ndli_rod_try_step(ndl_rod *rod, double dt, int euler, ndl_rod_info *info)
{
    double beta = euler ? 1 : 0.25, gamma = euler ? 1 : 0.5, keep = euler ? 0 : 1;
    ndli_rod_problem problem;
    sb_result result;
    problem.inertia = 1 / (beta * dt * dt);
    problem.max_newton = rod->max_newton;
    problem.tolerance = rod->tolerance;
    for (int i = 0; i < rod->node_count; i++) {
        ndli_v3 to = ndli_madd(rod->x[i], dt, rod->v[i]), target = rod->target[i];
        rod->predicted[i] = rod->held[i] ? target : ndli_madd(to, keep * dt * dt * (0.5 - beta), rod->a[i]);
        rod->try_x[i] = rod->x[i];
    }
    ndli_rod_set_turns(rod, 1);
    ndli_rod_set_viscous(rod, rod->damping_stretch * gamma / (beta * dt), rod->damping_bending * gamma / (beta * dt),
                         keep * 0.5 * dt);
    result = ndli_rod_minimise(rod, &problem, info);
    if (result != SB_OK)
        return result;
    for (int i = 0; i < rod->node_count; i++) {
        ndli_v3 v =
            rod->has_velocity[i] ? rod->target_velocity[i] : ndli_scale(1 / dt, ndli_sub(rod->try_x[i], rod->x[i]));
        if (rod->held[i]) {
            rod->a[i] = ndli_scale(1 / dt, ndli_sub(v, rod->v[i]));
        } else {
            v = ndli_madd(rod->v[i], keep * dt * (1 - gamma), rod->a[i]);
            rod->a[i] = ndli_scale(problem.inertia, ndli_sub(rod->try_x[i], rod->predicted[i]));
            v = ndli_madd(v, gamma * dt, rod->a[i]);
        }
        rod->v[i] = v;
        rod->x[i] = rod->try_x[i];
    }
    ndli_rod_keep_momentum(rod, &problem, gamma * dt);
    for (int i = 0; i < rod->node_count; i++) /* in sb_real, too */
        if (!sb_v3_is_finite(ndli_to(rod->x[i])) || !sb_v3_is_finite(ndli_to(rod->v[i])) ||
            !ndli_is_finite(ndli_norm(rod->a[i])))
            return SB_ERROR_DIVERGED;
    memcpy(rod->theta, rod->try_theta, (size_t)ndli_rod_edges(rod) * sizeof *rod->theta);
    return ndli_rod_moved(rod) < 0 ? SB_OK : SB_ERROR_DIVERGED;
}

/* Whether the step has energy that came from nowhere. */
static int ndli_rod_gained(ndl_rod *rod)
{
    double lively, energy = ndli_rod_total_energy(rod, &lively);
    return energy - rod->energy_before > 0.01 * lively;
}

/* Starts or ends the energy monitor; 1 when it may be held against the step. */
static int ndli_rod_monitor_energy(ndl_rod *rod)
{
    double lively;
    int busy = ndli_rod_any_torque(rod) || rod->base_director_set;
    for (int i = 0; i < rod->node_count; i++)
        busy = busy || rod->turn[i] != 0 ||
               (rod->held[i] && (rod->has_velocity[i] || ndli_norm(ndli_sub(rod->target[i], rod->x[i])) > 0));
    if (busy) {
        rod->energy_monitored = 0;
    } else if (!rod->energy_monitored) {
        rod->energy_before = ndli_rod_total_energy(rod, &lively);
        rod->energy_monitored = 1;
    }
    return !busy;
}

NDLI_API int ndli_rod_step_euler(ndl_rod *rod, double dt)
{
    ndl_rod_info info;
    sb_result result;
    memset(&info, 0, sizeof info);
    ndli_rod_save(rod);
    result = ndli_rod_try_step(rod, dt, 1, &info);
    if (result == SB_OK)
        ndli_rod_read_reactions(rod);
    ndli_rod_set_viscous(rod, 0, 0, 0);
    if (result != SB_OK)
        ndli_rod_restore(rod);
    return result == SB_OK;
}

NDL_API sb_result ndl_rod_step(ndl_rod *rod, sb_real dt, ndl_rod_info *info)
{
    ndl_rod_info local;
    sb_result result;
    int watched;
    info = info ? info : &local;
    memset(info, 0, sizeof *info);
    if (!rod || !(dt > 0) || !sb_is_finite(dt))
        return ndli_rod_fail(info, SB_ERROR_ARGUMENT, "rod is NULL, or dt is not above 0");
    if (!ndli_rod_any_turn_held(rod) && ndli_rod_any_torque(rod))
        return ndli_rod_fail(info, SB_ERROR_UNCONSTRAINED, "a torque acts, but no edge is held against turning");
    watched = ndli_rod_monitor_energy(rod);
    ndli_rod_save(rod);
    result = ndli_rod_try_step(rod, (double)dt, 0, info);
    if (watched && (result != SB_OK || ndli_rod_gained(rod))) {
        ndli_rod_restore(rod);
        info->damped = 1;
        result = ndli_rod_try_step(rod, (double)dt, 1, info);
    }
    if (result == SB_OK)
        ndli_rod_read_reactions(rod);
    ndli_rod_set_viscous(rod, 0, 0, 0);
    if (result != SB_OK) {
        ndli_rod_restore(rod);
        return ndli_rod_fail(info, result, "Newton found no step that lowers the potential; the step was undone");
    }
    ndli_rod_clear_turns(rod);
    ndli_rod_publish(rod);
    info->error.element = info->error.node = -1;
    return SB_OK;
}

/* ---- statics ---- */

/* In how many pieces supports and turns go where they must: a quarter of the shortest edge, a radian. */
static int ndli_rod_pieces(const ndl_rod *rod)
{
    double shortest = rod->rest_length[0], farthest = 0, most = 0;
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        shortest = fmin(shortest, rod->rest_length[j]);
        most = fmax(most, fabs(rod->turn[j]));
    }
    for (int i = 0; i < rod->node_count; i++)
        if (rod->held[i])
            farthest = fmax(farthest, ndli_norm(ndli_sub(rod->target[i], rod->x[i])));
    return (int)fmin(1000, 1 + floor(fmax(4 * farthest / shortest, most)));
}

/* Moves the supports the share still to go, and finds the equilibrium there. */
static sb_result ndli_rod_solve_piece(ndl_rod *rod, const ndli_rod_problem *problem, double share, ndl_rod_info *info)
{
    sb_result result;
    for (int i = 0; i < rod->node_count; i++) {
        rod->predicted[i] = rod->x[i];
        if (rod->held[i])
            rod->predicted[i] =
                share < 1 ? ndli_madd(rod->x[i], share, ndli_sub(rod->target[i], rod->x[i])) : rod->target[i];
        rod->try_x[i] = rod->x[i];
    }
    ndli_rod_set_turns(rod, share);
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        rod->turn[j] *= 1 - share;
    result = ndli_rod_minimise(rod, problem, info);
    if (result != SB_OK)
        return result;
    memcpy(rod->x, rod->try_x, (size_t)rod->node_count * sizeof *rod->x);
    memcpy(rod->theta, rod->try_theta, (size_t)ndli_rod_edges(rod) * sizeof *rod->theta);
    return ndli_rod_follow(rod) < 0 ? SB_OK : SB_ERROR_DIVERGED;
}

static sb_result ndli_rod_solve_pieces(ndl_rod *rod, const ndl_rod_static_options *options, ndl_rod_info *info)
{
    ndli_rod_problem problem = {0, 20, 0.01};
    int pieces = ndli_rod_pieces(rod), most = options->max_newton;
    sb_result result = SB_OK;
    for (int piece = 0; piece < pieces - 1 && result == SB_OK; piece++)
        result = ndli_rod_solve_piece(rod, &problem, 1.0 / (pieces - piece), info);
    problem.tolerance = (double)options->tolerance;
    for (int done = 0; result == SB_OK && done < most; done += problem.max_newton) {
        /* frames are measured from where the last round ended: none may turn far between two */
        problem.max_newton = sbi_max_int(2, sbi_min_int(10, most - done));
        result = ndli_rod_solve_piece(rod, &problem, 1, info);
        rod->base_director_set = 0;
        if (!info->capped)
            break;
    }
    return result == SB_OK && info->capped ? SB_ERROR_NOT_CONVERGED : result;
}

NDL_API sb_result ndl_rod_solve_static(ndl_rod *rod, const ndl_rod_static_options *options, ndl_rod_info *info)
{
    ndl_rod_static_options defaults = ndl_default_rod_static_options();
    ndl_rod_info local;
    sb_result result;
    size_t n;
    int base_director_set;
    info = info ? info : &local;
    memset(info, 0, sizeof *info);
    options = options ? options : &defaults;
    if (!rod || !ndli_rod_static_options_valid(options))
        return ndli_rod_fail(info, SB_ERROR_ARGUMENT, "rod is NULL, or options are out of range");
    if (!ndli_rod_any(rod->held, rod->node_count))
        return ndli_rod_fail(info, SB_ERROR_UNCONSTRAINED, "no node is held");
    if (!ndli_rod_any_turn_held(rod) && ndli_rod_any_torque(rod))
        return ndli_rod_fail(info, SB_ERROR_UNCONSTRAINED, "a torque acts, but no edge is held against turning");
    n = (size_t)rod->node_count;
    ndli_rod_save(rod);
    base_director_set = rod->base_director_set;
    memcpy(rod->saved_turns, rod->turn, n * sizeof *rod->turn);
    result = ndli_rod_solve_pieces(rod, options, info);
    if (result != SB_OK) {
        ndli_rod_restore(rod);
        memcpy(rod->turn, rod->saved_turns, n * sizeof *rod->turn);
        rod->base_director_set = base_director_set;
        return ndli_rod_fail(info, result,
                             result == SB_ERROR_NOT_CONVERGED
                                 ? "max_newton was reached; the rod is as it was"
                                 : "Newton found no step that lowers the energy; the rod is as it was");
    }
    memset(rod->v, 0, n * sizeof *rod->v);
    memset(rod->a, 0, n * sizeof *rod->a);
    ndli_rod_clear_turns(rod);
    ndli_rod_slip(rod);
    ndli_rod_read_reactions(rod);
    rod->energy_monitored = 0;
    ndli_rod_publish(rod);
    info->error.element = info->error.node = -1;
    return SB_OK;
}

/* ==== src/needle/rod_grip.c ==== */
/* rod_grip: what surrounds a rod holds it against turning: on every edge a torsion spring that slips at its limit
 * (elastic, then perfectly plastic), one end on the rod, the other in the surroundings.
 *
 * A spring is wound by lag = theta - anchor, and its potential is convex: 1/2 k lag^2 up to the lag limit/k, straight
 * beyond. Minimising it together with twist and bending from the anchors of the last state is one implicit step of the
 * plastic flow; the anchors then follow what has slipped. Where the frame that theta is measured from turns by itself
 * (folded reference twist, other nodes), theta and anchor change alike. */

NDLI_API double ndli_rod_grip_moment(const ndl_rod *rod, int j, double lag)
{
    double moment = rod->grip[j] * lag, limit = rod->grip_limit[j];
    return moment > limit ? limit : moment < -limit ? -limit : moment;
}

NDLI_API void ndli_rod_add_grip_energy(const ndl_rod *rod, ndli_rod_sums *sums)
{
    double turned = 0, moments = 0;
    for (int i = 1; i < rod->node_count - 1; i++)
        moments += 2 * rod->torsion / rod->cell[i] * fabs(rod->shape.twist[i]);
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        double lag = rod->shape.lag[j], moment = fabs(ndli_rod_grip_moment(rod, j, lag));
        turned = fmax(turned, fabs(lag) + fabs(rod->anchor[j]));
        if (!(rod->grip[j] > 0))
            continue;
        moments += moment;
        sums->grip += moment * (fabs(lag) - 0.5 * moment / rod->grip[j]);
    }
    sums->turn_noise = 2.3e-16 * turned * moments;
}

NDLI_API void ndli_rod_add_grip_derivatives(const ndl_rod *rod, double *turn_gradient, ndli_rod_matrix *matrix)
{
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        double lag = rod->shape.lag[j];
        turn_gradient[j] += ndli_rod_grip_moment(rod, j, lag);
        if (matrix && rod->grip[j] * fabs(lag) < rod->grip_limit[j])
            matrix->turn[j] += rod->grip[j];
    }
}

NDLI_API void ndli_rod_slip(ndl_rod *rod)
{
    for (int j = 0; j < ndli_rod_edges(rod) && rod->grips > 0; j++) {
        double lag = rod->theta[j] - rod->anchor[j];
        if (!(rod->grip[j] > 0))
            rod->anchor[j] = rod->theta[j];
        else if (rod->grip[j] * fabs(lag) > rod->grip_limit[j])
            rod->anchor[j] = rod->theta[j] - ndli_rod_grip_moment(rod, j, lag) / rod->grip[j];
        rod->shape.lag[j] = rod->theta[j] - rod->anchor[j];
    }
}

NDLI_API void ndli_rod_set_grip(ndl_rod *rod, int edge, double stiffness, double limit)
{
    double lag = rod->theta[edge] - rod->anchor[edge];
    rod->grips += (stiffness > 0) - (rod->grip[edge] > 0);
    if (!(stiffness > 0))
        lag = 0;
    else if (stiffness > rod->grip[edge]) /* what comes to it is not wound */
        lag *= rod->grip[edge] / stiffness;
    rod->grip[edge] = stiffness;
    rod->grip_limit[edge] = stiffness > 0 ? limit : 0;
    if (stiffness * fabs(lag) > limit)
        lag = ndli_rod_grip_moment(rod, edge, lag) / stiffness;
    rod->anchor[edge] = rod->theta[edge] - lag;
    rod->energy_monitored = 0;
}

NDLI_API void ndli_rod_turn_base(ndl_rod *rod, double angle) { rod->theta[0] += angle; }

NDL_API sb_result ndl_rod_set_grip(ndl_rod *rod, int edge, sb_real stiffness, sb_real limit)
{
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (edge < 0 || edge >= ndli_rod_edges(rod))
        return SB_ERROR_INDEX;
    if (!sb_is_finite(stiffness) || !sb_is_finite(limit))
        return SB_ERROR_NOT_FINITE;
    if (stiffness < 0 || limit < 0)
        return SB_ERROR_ARGUMENT;
    ndli_rod_set_grip(rod, edge, (double)stiffness, (double)limit);
    return SB_OK;
}

NDL_API sb_real ndl_rod_grip_torque(const ndl_rod *rod, int edge)
{
    if (!ndli_rod_has_edge(rod, edge))
        return 0;
    return (sb_real)-ndli_rod_grip_moment(rod, edge, rod->theta[edge] - rod->anchor[edge]);
}

/* ---- carried along where edges change ---- */

NDLI_API void ndli_rod_split_grip(ndl_rod *rod, int edge)
{
    rod->anchor[edge + 1] = rod->anchor[edge];
    rod->grip[edge] *= 0.5;
    rod->grip_limit[edge] *= 0.5;
    rod->grip[edge + 1] = rod->grip[edge];
    rod->grip_limit[edge + 1] = rod->grip_limit[edge];
    rod->grips += rod->grip[edge] > 0;
}

/* The angle of `to` is that of the merged edge already; `lags` are from before. */
NDLI_API void ndli_rod_merge_grip(ndl_rod *rod, int from, int to, const double lags[2])
{
    double sum = rod->grip[from] + rod->grip[to], lag = 0;
    if (sum > 0)
        lag = (rod->grip[from] * lags[0] + rod->grip[to] * lags[1]) / sum;
    rod->grips -= rod->grip[from] > 0 && rod->grip[to] > 0;
    rod->grip[to] = sum;
    rod->grip_limit[to] += rod->grip_limit[from];
    rod->anchor[to] = rod->theta[to] - lag;
}

/* Slope of the lag along gripped edges (rad/m), the lesser of those to both sides: where they differ in sign, or where
 * the grip ends, the lag is flat. Averages of a lag so sloped keep its torque, and do not wash it out. */
static double ndli_rod_lag_slope(const ndl_rod *rod, const double *at, int j)
{
    double slopes[2];
    for (int side = 0; side < 2; side++) {
        int a = j - 1 + side, b = j + side;
        if (a < 0 || b >= ndli_rod_edges(rod) || !(rod->grip[a] > 0) || !(rod->grip[b] > 0))
            return 0;
        slopes[side] = (rod->theta[b] - rod->anchor[b] - rod->theta[a] + rod->anchor[a]) /
                       (0.5 * (at[b + 1] + at[b] - at[a + 1] - at[a]));
    }
    if (!(slopes[0] * slopes[1] > 0))
        return 0;
    return fabs(slopes[0]) < fabs(slopes[1]) ? slopes[0] : slopes[1];
}

NDLI_API void ndli_rod_spread_grip(const ndl_rod *rod, const double *old_at, const double *at, int count,
                                   ndli_rod_spread *spread)
{
    int first = 0;
    for (int k = 0; k < count - 1; k++) {
        double grip = 0, limit = 0, torque = 0;
        for (int j = first; j < ndli_rod_edges(rod) && old_at[j] < at[k + 1]; j++) {
            double from = fmax(at[k], old_at[j]), to = fmin(at[k + 1], old_at[j + 1]);
            double share = (to - from) / (old_at[j + 1] - old_at[j]);
            double off = 0.5 * (from + to - old_at[j] - old_at[j + 1]);
            if (!(share > 0)) {
                first = j; /* passed */
                continue;
            }
            grip += share * rod->grip[j];
            limit += share * rod->grip_limit[j];
            torque +=
                share * rod->grip[j] * (rod->theta[j] - rod->anchor[j] + off * ndli_rod_lag_slope(rod, old_at, j));
        }
        spread->grip[k] = grip;
        spread->limit[k] = limit;
        spread->lag[k] = grip > 0 ? torque / grip : 0;
    }
}

/* ==== src/needle/rod_reshape.c ==== */
/* rod_reshape: other nodes on a rod's own curve. Needles slide along the nodes of their tissue: after a step the
 * coupled nodes go back to these, and what the rod carries is measured anew where they are.
 *
 * Arc distances of the new polyline are scaled to the old one's, so that both ends agree; between the ends of a
 * clamped base edge and beyond it by a scale of their own, so that the clamp keeps its edge. Interpolation is Akima's
 * (1970, "A new method of interpolation and smooth curve fitting based on local procedures"): local, without
 * overshoot next to straight data, but not monotone. */

/* ---- interpolation ---- */

/* value[count] at the stations at[count], rising; slope[count] is Akima's. */
typedef struct ndli_rod_curve {
    double *at, *value, *slope;
    int count;
} ndli_rod_curve;

/* Slope from station i to the next; two beyond each end follow the parabola through the last three. */
static double ndli_rod_secant(const ndli_rod_curve *curve, int i)
{
    int last = curve->count - 2;
    if (last < 1) /* two stations: a straight line */
        i = 0;
    if (i < 0)
        return ndli_rod_secant(curve, 0) + i * (ndli_rod_secant(curve, 1) - ndli_rod_secant(curve, 0));
    if (i > last)
        return ndli_rod_secant(curve, last) +
               (i - last) * (ndli_rod_secant(curve, last) - ndli_rod_secant(curve, last - 1));
    return (curve->value[i + 1] - curve->value[i]) / (curve->at[i + 1] - curve->at[i]);
}

static void ndli_rod_set_slopes(ndli_rod_curve *curve)
{
    for (int i = 0; i < curve->count; i++) {
        double m[4], before, after;
        for (int k = 0; k < 4 && curve->count > 1; k++)
            m[k] = ndli_rod_secant(curve, i - 2 + k);
        if (curve->count < 2) {
            curve->slope[i] = 0;
            continue;
        }
        before = fabs(m[3] - m[2]);
        after = fabs(m[1] - m[0]);
        curve->slope[i] = before + after > 0 ? (before * m[1] + after * m[2]) / (before + after) : 0.5 * (m[1] + m[2]);
    }
}

/* The last station not beyond u, looked for from *cursor on, which only goes up; -1: u lies before all of them. */
static int ndli_rod_station(const double *at, int count, double u, int *cursor)
{
    while (*cursor + 1 < count && at[*cursor + 1] <= u)
        ++*cursor;
    return at[*cursor] <= u ? *cursor : -1;
}

/* Beyond the first and last station the curve goes on straight, by its slope there or (flat) by none. */
static double ndli_rod_curve_at(const ndli_rod_curve *curve, double u, int flat, int *cursor)
{
    int i = ndli_rod_station(curve->at, curve->count, u, cursor), outside = i < 0 || i == curve->count - 1;
    double d, width, m, s0, s1;
    i = sbi_max_int(i, 0);
    d = u - curve->at[i];
    s0 = curve->slope[i];
    if (outside)
        return curve->value[i] + (flat ? 0 : s0 * d);
    s1 = curve->slope[i + 1];
    width = curve->at[i + 1] - curve->at[i];
    m = ndli_rod_secant(curve, i);
    return curve->value[i] + d * (s0 + d / width * (3 * m - 2 * s0 - s1 + d / width * (s0 + s1 - 2 * m)));
}

/* ---- from the old nodes to the new ones ---- */

/* A reparameterisation while it is being made, all in the rod's scratch. */
typedef struct ndli_rod_reshape {
    int count;                   /* new nodes */
    const ndli_v3 *x;            /* [count] */
    ndli_v3 *v, *a;              /* [count] */
    ndli_v3 *tangent, *director; /* [count - 1] */
    double *old_at;              /* [old nodes] (m) arc distance of the old nodes */
    double *at;                  /* [count] the new nodes', on the same scale */
    double *length;              /* [count - 1] (m) */
    double *rest_length;         /* [count - 1] (m) */
    double *theta;               /* [count - 1] (rad) */
    double *curvature[2];        /* [count] (1/m) at rest; inner nodes */
    ndli_rod_spread grip;        /* [count - 1] */
    ndli_rod_curve curve;        /* what is interpolated; stations' room for the old nodes */
} ndli_rod_reshape;

/* Hands out the scratch: 13 of the 44 reals a node of rod->band, and node arrays but try_x. */
static ndli_rod_reshape ndli_rod_begin_reshape(ndl_rod *rod, const ndli_v3 *positions, int count)
{
    ndli_rod_reshape reshape;
    double *reals[13];
    for (int k = 0; k < 13; k++)
        reals[k] = rod->band + (size_t)k * (size_t)rod->capacity;
    reshape.count = count;
    reshape.x = positions;
    reshape.v = rod->best_x;
    reshape.a = rod->step_x;
    reshape.tangent = rod->predicted;
    reshape.director = rod->gradient;
    reshape.old_at = reals[0];
    reshape.at = reals[1];
    reshape.length = reals[2];
    reshape.rest_length = reals[3];
    reshape.theta = reals[4];
    reshape.curvature[0] = reals[5];
    reshape.curvature[1] = reals[6];
    reshape.curve.at = reals[7];
    reshape.curve.value = reals[8];
    reshape.curve.slope = reals[9];
    reshape.curve.count = 0;
    reshape.grip.grip = reals[10];
    reshape.grip.limit = reals[11];
    reshape.grip.lag = reals[12];
    return reshape;
}

/* Lengths and tangents of the new edges. -1, or the node at which there is no rod. */
static int ndli_rod_check_nodes(const ndl_rod *rod, ndli_rod_reshape *reshape)
{
    double reach = 0;
    for (int i = 0; i < reshape->count; i++)
        for (int k = 0; k < 3; k++) {
            if (!ndli_is_finite(ndli_component(reshape->x[i], k)))
                return i;
            reach = fmax(reach, fabs(ndli_component(reshape->x[i], k)));
        }
    for (int j = 0; j + 1 < reshape->count; j++) {
        ndli_v3 e = ndli_sub(reshape->x[j + 1], reshape->x[j]);
        double length = ndli_norm(e);
        if (!(length > 1e-12 * reach) || !ndli_is_finite(length))
            return j + 1;
        reshape->length[j] = length;
        reshape->tangent[j] = ndli_scale(1 / length, e);
        if (j > 0 && !ndli_rod_may_turn(reshape->tangent[j - 1], reshape->tangent[j]))
            return j;
    }
    return ndli_rod_may_turn(rod->tangent[0], reshape->tangent[0]) ? -1 : 1;
}

/* Stations of the old nodes and of the new ones. */
static void ndli_rod_set_stations(const ndl_rod *rod, ndli_rod_reshape *reshape)
{
    int n = rod->node_count, m = reshape->count, clamped = n > 2 && m > 2 && rod->held[0] && rod->held[1];
    double whole = 0, scale, *old = reshape->old_at, *at = reshape->at;
    old[0] = at[0] = 0;
    for (int i = 1; i < n; i++)
        old[i] = old[i - 1] + ndli_norm(ndli_sub(rod->x[i], rod->x[i - 1]));
    if (clamped)
        at[1] = old[1];
    for (int j = clamped; j < m - 1; j++)
        whole += reshape->length[j];
    scale = (old[n - 1] - at[clamped]) / whole;
    for (int i = clamped + 1; i < m - 1; i++)
        at[i] = at[i - 1] + scale * reshape->length[i - 1];
    at[m - 1] = old[n - 1];
}

/* rest_length from the cumulative one at the stations; linear: not by Akima. 0: some would be folded. */
static int ndli_rod_interpolate_lengths(const ndl_rod *rod, ndli_rod_reshape *reshape, int linear)
{
    ndli_rod_curve curve = reshape->curve;
    int cursor = 0, m = reshape->count;
    double before = 0;
    curve.at = reshape->old_at;
    curve.count = rod->node_count;
    curve.value[0] = 0;
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        curve.value[j + 1] = curve.value[j] + rod->rest_length[j];
    if (!linear)
        ndli_rod_set_slopes(&curve);
    for (int j = 0; j < m - 1; j++) {
        double u = reshape->at[j + 1], length, here = curve.value[curve.count - 1];
        if (linear && j < m - 2) {
            int i = ndli_rod_station(curve.at, curve.count, u, &cursor);
            here = curve.value[i] + (u - curve.at[i]) * ndli_rod_secant(&curve, i);
        } else if (j < m - 2) {
            here = ndli_rod_curve_at(&curve, u, 0, &cursor);
        }
        length = here - before;
        if (!linear && !(length > 0.2 * (u - reshape->at[j])))
            return 0;
        reshape->rest_length[j] = length;
        before = here;
    }
    return 1;
}

/* v and a, linear from node to node. */
static void ndli_rod_interpolate_motion(const ndl_rod *rod, ndli_rod_reshape *reshape)
{
    int cursor = 0, n = rod->node_count;
    for (int i = 0; i < reshape->count; i++) {
        int k = sbi_min_int(ndli_rod_station(reshape->old_at, n, reshape->at[i], &cursor), n - 2);
        double f = (reshape->at[i] - reshape->old_at[k]) / (reshape->old_at[k + 1] - reshape->old_at[k]);
        reshape->v[i] = ndli_add(ndli_scale(1 - f, rod->v[k]), ndli_scale(f, rod->v[k + 1]));
        reshape->a[i] = ndli_add(ndli_scale(1 - f, rod->a[k]), ndli_scale(f, rod->a[k + 1]));
    }
}

/* What a clamped base edge leaves of node 1's cell, once the rod has more than one inner node. */
static int ndli_rod_has_half_cell(const ndl_rod *rod, int nodes) { return nodes > 3 && rod->held[0] && rod->held[1]; }

/* Stations and curvature (1/m) at rest, towards m1 or m2, of the inner nodes from `first` on; they keep 2 tan of half
 * the turn. */
static void ndli_rod_set_curvature(const ndl_rod *rod, const ndli_rod_reshape *reshape, int first, int k,
                                   ndli_rod_curve *curve)
{
    curve->count = 0;
    for (int i = first; i < rod->node_count - 1; i++) {
        const double *bend = rod->rest_bend[i];
        double size = sqrt(bend[0] * bend[0] + bend[1] * bend[1]);
        double turn = size > 0 ? 2 * sbi_dense_atan2(0.5 * size, 1) / size : 1;
        curve->at[curve->count] = reshape->old_at[i];
        curve->value[curve->count++] = turn * bend[k] / rod->cell[i];
    }
    ndli_rod_set_slopes(curve);
}

static void ndli_rod_interpolate_component(const ndl_rod *rod, ndli_rod_reshape *reshape, int k)
{
    ndli_rod_curve curve = reshape->curve;
    int half = ndli_rod_has_half_cell(rod, rod->node_count), cursor = 0;
    double *curvature = reshape->curvature[k], kink = 0, cell = 0;
    ndli_rod_set_curvature(rod, reshape, 1, k, &curve);
    if (half) {
        kink = rod->cell[1] * (curve.value[0] - curve.value[1]);
        ndli_rod_set_curvature(rod, reshape, 2, k, &curve);
    }
    for (int i = 1; i < reshape->count - 1; i++)
        curvature[i] = curve.count < 1 ? 0 : ndli_rod_curve_at(&curve, reshape->at[i], 1, &cursor);
    if (half && reshape->count > 2) {
        cell = 0.5 * (reshape->rest_length[1] + (reshape->count > 3 ? 0 : reshape->rest_length[0]));
        curvature[1] += kink / cell;
    }
}

/* Curvature at rest of the inner nodes. In a clamp there is none: what turns node 1 beyond the curvature of the rod
 * that comes out there (as in a needle whose whole shape is its rest) is a kink, and stays as it is. -1, or the new
 * node that would turn the rod back. */
static int ndli_rod_interpolate_curvature(const ndl_rod *rod, ndli_rod_reshape *reshape)
{
    for (int k = 0; k < 2; k++)
        ndli_rod_interpolate_component(rod, reshape, k);
    for (int i = 1; i < reshape->count - 1; i++) {
        double k0 = reshape->curvature[0][i], k1 = reshape->curvature[1][i], cell = reshape->rest_length[i];
        if (i > 1 || !ndli_rod_has_half_cell(rod, reshape->count))
            cell += reshape->rest_length[i - 1];
        if (!(0.5 * sqrt(k0 * k0 + k1 * k1) * cell < 2.9))
            return i;
    }
    return -1;
}

/* Director and angle of the new edges. Angles are measured from a frame that parallel transport lays along the
 * polyline, and along another polyline it lies a little otherwise: material frames are kept, angles make up for it. */
static void ndli_rod_interpolate_frames(const ndl_rod *rod, ndli_rod_reshape *reshape)
{
    ndli_rod_curve curve = reshape->curve;
    int cursor = 0, edge = 0;
    curve.count = ndli_rod_edges(rod);
    for (int j = 0; j < curve.count; j++) {
        curve.at[j] = 0.5 * (reshape->old_at[j] + reshape->old_at[j + 1]);
        curve.value[j] = rod->theta[j];
    }
    ndli_rod_set_slopes(&curve);
    reshape->theta[0] = rod->theta[0];
    reshape->director[0] = ndli_rod_across(ndli_rod_transport(rod->tangent[0], reshape->tangent[0], rod->director[0]),
                                           reshape->tangent[0]);
    for (int j = 1; j < reshape->count - 1; j++) {
        ndli_v3 t = reshape->tangent[j], d, carried;
        double u = 0.5 * (reshape->at[j] + reshape->at[j + 1]);
        d = ndli_rod_across(ndli_rod_transport(reshape->tangent[j - 1], t, reshape->director[j - 1]), t);
        reshape->director[j] = d;
        reshape->theta[j] = ndli_rod_curve_at(&curve, u, 0, &cursor);
        edge = sbi_min_int(ndli_rod_station(reshape->old_at, rod->node_count, u, &edge), curve.count - 1);
        if (!ndli_rod_may_turn(rod->tangent[edge], t))
            continue;
        carried = ndli_rod_transport(rod->tangent[edge], t, rod->director[edge]);
        reshape->theta[j] += sbi_dense_atan2(ndli_dot(ndli_cross(d, carried), t), ndli_dot(d, carried));
    }
}

/* ---- the rod takes its new nodes ---- */

/* Supports and loads beyond the base edge are gone: their nodes are. */
static void ndli_rod_drop_supports(ndl_rod *rod)
{
    for (int i = 2; i < rod->node_count; i++) {
        rod->held[i] = rod->has_velocity[i] = 0;
        rod->force[i] = rod->reaction[i] = ndli_v(0, 0, 0);
    }
    for (int j = 1; j < rod->node_count - 1; j++) {
        rod->turn_held[j] = 0;
        rod->turn[j] = rod->torque[j] = rod->reaction_torque[j] = 0;
    }
}

static ndli_v3 ndli_rod_momentum(const ndl_rod *rod)
{
    ndli_v3 sum = ndli_v(0, 0, 0);
    for (int i = 0; i < rod->node_count; i++)
        sum = ndli_madd(sum, rod->mass[i], rod->v[i]);
    return sum;
}

/* Free nodes get what is missing of the momentum, all the same velocity. */
static void ndli_rod_restore_momentum(ndl_rod *rod, ndli_v3 momentum)
{
    ndli_v3 missing = ndli_sub(momentum, ndli_rod_momentum(rod));
    double mass = 0;
    for (int i = 0; i < rod->node_count; i++)
        mass += rod->held[i] ? 0 : rod->mass[i];
    for (int i = 0; i < rod->node_count && mass > 0; i++)
        if (!rod->held[i])
            rod->v[i] = ndli_madd(rod->v[i], 1 / mass, missing);
}

static void ndli_rod_take_reshape(ndl_rod *rod, const ndli_rod_reshape *reshape)
{
    size_t nodes = (size_t)reshape->count, edges = nodes - 1;
    ndli_v3 momentum = ndli_rod_momentum(rod);
    rod->node_count = reshape->count;
    memmove(rod->x, reshape->x, nodes * sizeof *rod->x);
    memcpy(rod->v, reshape->v, nodes * sizeof *rod->v);
    memcpy(rod->a, reshape->a, nodes * sizeof *rod->a);
    memcpy(rod->tangent, reshape->tangent, edges * sizeof *rod->tangent);
    memcpy(rod->director, reshape->director, edges * sizeof *rod->director);
    memcpy(rod->theta, reshape->theta, edges * sizeof *rod->theta);
    memcpy(rod->grip, reshape->grip.grip, edges * sizeof *rod->grip);
    memcpy(rod->grip_limit, reshape->grip.limit, edges * sizeof *rod->grip_limit);
    rod->grips = 0;
    for (size_t j = 0; j < edges; j++) {
        rod->anchor[j] = rod->theta[j] - reshape->grip.lag[j];
        rod->grips += rod->grip[j] > 0;
    }
    memcpy(rod->rest_length, reshape->rest_length, edges * sizeof *rod->rest_length);
    ndli_rod_drop_supports(rod);
    ndli_rod_rest_changed(rod);
    ndli_rod_restore_momentum(rod, momentum);
    memset(rod->rest_bend, 0, nodes * sizeof *rod->rest_bend);
    for (int i = 1; i < rod->node_count - 1; i++)
        ndli_rod_bend_to(rod, i, reshape->curvature[0][i], reshape->curvature[1][i]);
}

NDLI_API int ndli_rod_reparameterise(ndl_rod *rod, const ndli_v3 *positions, int count)
{
    ndli_rod_reshape reshape = ndli_rod_begin_reshape(rod, positions, count);
    int bad = ndli_rod_check_nodes(rod, &reshape);
    if (bad >= 0)
        return bad;
    ndli_rod_set_stations(rod, &reshape);
    if (!ndli_rod_interpolate_lengths(rod, &reshape, 0))
        ndli_rod_interpolate_lengths(rod, &reshape, 1);
    for (int j = 0; j < count - 1; j++) /* what ndli_rod_set_shape asks for */
        if (!(reshape.length[j] > 1e-3 * reshape.rest_length[j]) || !(reshape.rest_length[j] > 0))
            return j + 1;
    bad = ndli_rod_interpolate_curvature(rod, &reshape);
    if (bad >= 0)
        return bad;
    ndli_rod_interpolate_motion(rod, &reshape);
    ndli_rod_interpolate_frames(rod, &reshape);
    ndli_rod_spread_grip(rod, reshape.old_at, reshape.at, count, &reshape.grip);
    ndli_rod_take_reshape(rod, &reshape);
    rod->energy_monitored = 0;
    ndli_rod_relax(rod);
    ndli_rod_slip(rod);
    return -1;
}

NDL_API sb_result ndl_rod_reparameterise(ndl_rod *rod, const sb_vec3 *positions, int count, sb_error *error)
{
    int bad;
    if (!rod || !positions || count < 2)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "rod or positions is NULL, or count is below 2");
    if (count > rod->capacity)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "%d nodes are more than the capacity %d", count, rod->capacity);
    for (int i = 0; i < count; i++) {
        if (!sb_v3_is_finite(positions[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "node %d is not finite", i);
        rod->try_x[i] = ndli_from(positions[i]);
    }
    bad = ndli_rod_reparameterise(rod, rod->try_x, count);
    if (bad >= 0)
        return sbi_fail_node(error, SB_ERROR_MESH, bad, "the rod has no length or turns back at node %d", bad);
    ndli_rod_publish(rod);
    return SB_OK;
}

/* ==== src/needle/topology.c ==== */
/* topology: rings of tets about nodes, cuts and their way back, walks.
 *
 * A ring of corners instead of lists of tets: joining and leaving cost O(1) and no memory, so only the arrays of nodes
 * and tets ever grow. */


#include <limits.h>
#include <string.h>

/* ---- memory ---- */

static void ndli_topology_layout(ndli_topology *t, sbi_arena *arena, size_t nodes, size_t tets)
{
    t->X = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    t->X0 = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    t->owner = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    t->node_star = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    t->displaced = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    t->displaced_at = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    t->node_index = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    t->node_flags = (unsigned char *)sbi_arena_take(arena, nodes, 1);
    t->node_mark = (unsigned char *)sbi_arena_take(arena, nodes, 1);
    t->tets = (int *)sbi_arena_take(arena, tets, 4 * sizeof(int));
    t->neighbours = (int *)sbi_arena_take(arena, tets, 4 * sizeof(int));
    t->corner_next = (int *)sbi_arena_take(arena, tets, 4 * sizeof(int));
    t->corner_prev = (int *)sbi_arena_take(arena, tets, 4 * sizeof(int));
    t->regions = (int *)sbi_arena_take(arena, tets, sizeof(int));
    t->parents = (int *)sbi_arena_take(arena, tets, sizeof(int));
    t->volumes = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
    t->qualities = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
    t->tet_mark = (unsigned char *)sbi_arena_take(arena, tets, 1);
    t->touched = (int *)sbi_arena_take(arena, tets, sizeof(int));
    t->affected = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    t->node_events = (ndli_node_event *)sbi_arena_take(arena, nodes, 2 * sizeof(ndli_node_event));
    t->displaced_before = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    t->tet_events = (int *)sbi_arena_take(arena, tets, 2 * sizeof(int));
    t->changed = (int *)sbi_arena_take(arena, tets, sizeof(int));
    t->changes = (ndli_node_change *)sbi_arena_take(arena, nodes, sizeof(ndli_node_change));
}

/* Points the arrays into a fresh block of zeros for so many nodes and tets; 0: no memory, *t as it was. */
static int ndli_topology_allocate(ndli_topology *t, int nodes, int tets)
{
    ndli_topology made = *t;
    sbi_arena arena;
    memset(&arena, 0, sizeof arena);
    ndli_topology_layout(&made, &arena, (size_t)nodes, (size_t)tets);
    if (arena.overflow)
        return 0;
    arena.base = (unsigned char *)sbi_alloc_zeroed(&t->allocator, arena.used, 1);
    if (!arena.base)
        return 0;
    arena.used = 0;
    ndli_topology_layout(&made, &arena, (size_t)nodes, (size_t)tets);
    made.block = arena.base;
    made.node_capacity = nodes;
    made.tet_capacity = tets;
    *t = made;
    return 1;
}

static void ndli_topology_copy_nodes(ndli_topology *to, const ndli_topology *from)
{
    size_t n = (size_t)from->node_end;
    memcpy(to->X, from->X, n * sizeof(sb_vec3));
    memcpy(to->X0, from->X0, n * sizeof(sb_vec3));
    memcpy(to->owner, from->owner, n * sizeof(int));
    memcpy(to->node_star, from->node_star, n * sizeof(int));
    memcpy(to->displaced, from->displaced, n * sizeof(int));
    memcpy(to->displaced_at, from->displaced_at, n * sizeof(int));
    memcpy(to->node_flags, from->node_flags, n);
}

static void ndli_topology_copy_tets(ndli_topology *to, const ndli_topology *from)
{
    size_t n = (size_t)from->tet_end;
    memcpy(to->tets, from->tets, 4 * n * sizeof(int));
    memcpy(to->neighbours, from->neighbours, 4 * n * sizeof(int));
    memcpy(to->corner_next, from->corner_next, 4 * n * sizeof(int));
    memcpy(to->corner_prev, from->corner_prev, 4 * n * sizeof(int));
    memcpy(to->regions, from->regions, n * sizeof(int));
    memcpy(to->parents, from->parents, n * sizeof(int));
    memcpy(to->volumes, from->volumes, n * sizeof(sb_real));
    memcpy(to->qualities, from->qualities, n * sizeof(sb_real));
}

/* end + more + half of it; INT_MAX / 8 at most, so that corners and lists of twice as many still fit an int. */
static int ndli_topology_grown(int end, int more)
{
    int64_t need = (int64_t)end + more, roomy = need + need / 2;
    int64_t limit = INT_MAX / 8;
    return need > limit ? -1 : (int)(roomy < limit ? roomy : limit);
}

NDLI_API int ndli_topology_reserve(ndli_topology *mesh, int nodes, int tets)
{
    ndli_topology grown = *mesh;
    int node_capacity = mesh->node_capacity, tet_capacity = mesh->tet_capacity;
    if (nodes <= mesh->node_capacity - mesh->node_count && tets <= mesh->tet_capacity - mesh->tet_count)
        return 1;
    if (nodes > mesh->node_capacity - mesh->node_count)
        node_capacity = ndli_topology_grown(mesh->node_end, nodes);
    if (tets > mesh->tet_capacity - mesh->tet_count)
        tet_capacity = ndli_topology_grown(mesh->tet_end, tets);
    if (node_capacity < 0 || tet_capacity < 0 || !ndli_topology_allocate(&grown, node_capacity, tet_capacity))
        return 0;
    ndli_topology_copy_nodes(&grown, mesh);
    ndli_topology_copy_tets(&grown, mesh);
    sbi_free(&mesh->allocator, mesh->block);
    *mesh = grown;
    return 1;
}

NDLI_API void ndli_topology_free(ndli_topology *mesh)
{
    sb_allocator allocator;
    if (!mesh)
        return;
    allocator = mesh->allocator;
    sbi_free(&allocator, mesh->block);
    memset(mesh, 0, sizeof *mesh);
}

/* ---- geometry ---- */

/* Six times the volume. */
static sb_real ndli_topology_det(sb_vec3 a, sb_vec3 b, sb_vec3 c, sb_vec3 d)
{
    return sb_v3_dot(sb_v3_sub(b, a), sb_v3_cross(sb_v3_sub(c, a), sb_v3_sub(d, a)));
}

NDLI_API void ndli_tet_weights(sb_vec3 a, sb_vec3 b, sb_vec3 c, sb_vec3 d, sb_vec3 p, sb_real weights[4])
{
    sb_real det = ndli_topology_det(a, b, c, d);
    weights[0] = ndli_topology_det(p, b, c, d) / det;
    weights[1] = ndli_topology_det(a, p, c, d) / det;
    weights[2] = ndli_topology_det(a, b, p, d) / det;
    weights[3] = ndli_topology_det(a, b, c, p) / det;
}

static void ndli_topology_measure(ndli_topology *t, int tet)
{
    const int *n = t->tets + 4 * (size_t)tet;
    t->volumes[tet] = ndli_topology_det(t->X[n[0]], t->X[n[1]], t->X[n[2]], t->X[n[3]]) / 6;
    t->qualities[tet] = ndli_tet_quality(t->X[n[0]], t->X[n[1]], t->X[n[2]], t->X[n[3]]);
}

/* ---- rings ----
 * Ascending, so that they are a function of the mesh alone: sums over them have the same bits whatever was done and
 * undone. */

static void ndli_topology_join(ndli_topology *t, int corner, int node)
{
    int prev = -1, next = t->node_star[node];
    while (next >= 0 && next < corner) {
        prev = next;
        next = t->corner_next[next];
    }
    t->tets[corner] = node;
    t->corner_next[corner] = next;
    t->corner_prev[corner] = prev;
    if (next >= 0)
        t->corner_prev[next] = corner;
    if (prev >= 0)
        t->corner_next[prev] = corner;
    else
        t->node_star[node] = corner;
}

static void ndli_topology_leave(ndli_topology *t, int corner)
{
    int next = t->corner_next[corner], prev = t->corner_prev[corner];
    if (prev >= 0)
        t->corner_next[prev] = next;
    else
        t->node_star[t->tets[corner]] = next;
    if (next >= 0)
        t->corner_prev[next] = prev;
}

/* 1 when the tet has all these nodes. */
static int ndli_topology_holds(const ndli_topology *t, int tet, const int *nodes, int count)
{
    const int *n = t->tets + 4 * (size_t)tet;
    for (int i = 0; i < count; i++)
        if (n[0] != nodes[i] && n[1] != nodes[i] && n[2] != nodes[i] && n[3] != nodes[i])
            return 0;
    return 1;
}

/* The nodes of the face opposite node `face`. */
static void ndli_topology_face(const ndli_topology *t, int tet, int face, int nodes[3])
{
    for (int c = 0, k = 0; c < 4; c++)
        if (c != face)
            nodes[k++] = t->tets[4 * (size_t)tet + (size_t)c];
}

/* Finds the tet behind each face, and tells it. */
static void ndli_topology_link(ndli_topology *t, int tet)
{
    for (int face = 0; face < 4; face++) {
        int nodes[3], other = -1;
        ndli_topology_face(t, tet, face, nodes);
        for (int k = t->node_star[nodes[0]]; k >= 0 && other < 0; k = t->corner_next[k])
            if (k / 4 != tet && ndli_topology_holds(t, k / 4, nodes + 1, 2))
                other = k / 4;
        t->neighbours[4 * (size_t)tet + (size_t)face] = other;
        for (int c = 0; other >= 0 && c < 4; c++) {
            int node = t->tets[4 * (size_t)other + (size_t)c];
            if (node != nodes[0] && node != nodes[1] && node != nodes[2])
                t->neighbours[4 * (size_t)other + (size_t)c] = tet;
        }
    }
}

/* ---- reading a body's mesh ---- */

/* Free slots as lists: the next one to be used first, which is the last of the body's. */
static void ndli_topology_read_free(ndli_topology *t, const sb_body *body)
{
    sbi_body_slots nodes = sbi_body_node_slots(body), cells = sbi_body_cell_slots(body);
    t->free_node = t->free_tet = -1;
    for (int i = 0; i < nodes.free_count; i++) {
        t->node_star[nodes.free[i]] = t->free_node;
        t->free_node = nodes.free[i];
    }
    for (int i = 0; i < cells.free_count; i++) {
        t->neighbours[4 * (size_t)cells.free[i]] = t->free_tet;
        t->free_tet = cells.free[i];
    }
}

static void ndli_topology_read_nodes(ndli_topology *t, const sb_body *body)
{
    const sb_vec3 *X = sb_body_rest_positions(body);
    t->node_end = sbi_body_node_slots(body).end;
    t->displaced_count = 0;
    for (int n = 0; n < t->node_end; n++) {
        t->owner[n] = t->node_star[n] = t->displaced_at[n] = -1;
        t->node_flags[n] = t->node_mark[n] = 0;
        t->X[n] = t->X0[n] = sb_body_node_in_use(body, n) ? X[n] : sb_v3(0, 0, 0);
    }
}

static void ndli_topology_read_tets(ndli_topology *t, const sb_body *body)
{
    t->tet_end = sbi_body_cell_slots(body).end;
    t->tet_count = 0;
    for (int e = t->tet_end - 1; e >= 0; e--) { /* each joins before all that are there */
        const int *nodes = sb_body_cell_nodes(body, e);
        memset(t->tets + 4 * (size_t)e, -1, 4 * sizeof(int));
        t->parents[e] = e;
        t->tet_mark[e] = 0;
        t->regions[e] = sbi_body_cell_region(body, e);
        for (int c = 3; nodes && c >= 0; c--)
            ndli_topology_join(t, 4 * e + c, nodes[c]);
        if (nodes) {
            ndli_topology_measure(t, e);
            t->tet_count++;
        }
    }
}

/* Neighbours, and which nodes are in tets, on the surface and between regions. */
static void ndli_topology_connect(ndli_topology *t)
{
    for (int e = 0; e < t->tet_end; e++)
        if (t->tets[4 * (size_t)e] >= 0)
            ndli_topology_link(t, e);
    for (int e = 0; e < t->tet_end; e++)
        for (int face = 0; face < 4 && t->tets[4 * (size_t)e] >= 0; face++) {
            int nodes[3], other = t->neighbours[4 * (size_t)e + (size_t)face];
            int flag = other < 0 ? NDLI_NODE_BOUNDARY : t->regions[other] != t->regions[e] ? NDLI_NODE_INTERFACE : 0;
            ndli_topology_face(t, e, face, nodes);
            for (int i = 0; i < 3; i++)
                t->node_flags[nodes[i]] = (unsigned char)(t->node_flags[nodes[i]] | flag);
        }
    t->node_count = 0;
    for (int n = 0; n < t->node_end; n++)
        if (t->node_star[n] >= 0) {
            t->node_flags[n] |= NDLI_NODE_ALIVE;
            t->node_count++;
        }
}

NDLI_API int ndli_topology_read(ndli_topology *mesh, const sb_body *body)
{
    sbi_body_slots nodes = sbi_body_node_slots(body), cells = sbi_body_cell_slots(body);
    if (nodes.end > mesh->node_capacity || cells.end > mesh->tet_capacity) {
        ndli_topology larger;
        memset(&larger, 0, sizeof larger);
        larger.allocator = mesh->allocator;
        if (nodes.room > INT_MAX / 8 || cells.room > INT_MAX / 8 ||
            !ndli_topology_allocate(&larger, nodes.room, cells.room))
            return 0;
        sbi_free(&mesh->allocator, mesh->block);
        *mesh = larger;
    }
    ndli_topology_read_nodes(mesh, body);
    ndli_topology_read_tets(mesh, body);
    ndli_topology_connect(mesh);
    ndli_topology_read_free(mesh, body);
    mesh->original_nodes = mesh->node_end;
    mesh->original_tets = mesh->tet_end;
    ndli_topology_look(mesh, body);
    return 1;
}

NDLI_API void ndli_topology_read_again(ndli_topology *mesh, const sb_body *body)
{
    const sb_vec3 *X = sb_body_rest_positions(body);
    int end = sbi_body_node_slots(body).end;
    mesh->node_count = 0;
    for (int n = 0; n < end; n++) {
        mesh->node_star[n] = -1;
        mesh->node_mark[n] = 0;
        mesh->X[n] = sb_body_node_in_use(body, n) ? X[n] : sb_v3(0, 0, 0);
        mesh->node_count += mesh->node_flags[n] != 0;
    }
    mesh->node_end = end;
    ndli_topology_read_tets(mesh, body);
    for (int e = 0; e < mesh->tet_end; e++)
        if (mesh->tets[4 * (size_t)e] >= 0)
            ndli_topology_link(mesh, e);
    ndli_topology_read_free(mesh, body);
    mesh->x = sb_body_positions(body);
}

NDLI_API void ndli_topology_look(ndli_topology *mesh, const sb_body *body)
{
    const unsigned char *supports = sb_body_supports(body);
    mesh->x = sb_body_positions(body);
    for (int n = 0; n < mesh->node_end; n++)
        if (mesh->node_flags[n])
            mesh->node_flags[n] = (unsigned char)(supports[n] ? mesh->node_flags[n] | NDLI_NODE_FIXED
                                                              : mesh->node_flags[n] & ~NDLI_NODE_FIXED);
}

/* ---- walks ---- */

static int ndli_topology_is_tet(const ndli_topology *t, int tet)
{
    return tet >= 0 && tet < t->tet_end && t->tets[4 * (size_t)tet] >= 0;
}

NDLI_API int ndli_topology_find(const ndli_topology *mesh, const sb_vec3 *positions, sb_vec3 point, int start,
                                sb_real weights[4])
{
    sb_real w[4], slack = -64 * SB_EPSILON;
    int tet = start, from = -1;
    if (!mesh || !positions || !ndli_topology_is_tet(mesh, start) || !sb_v3_is_finite(point))
        return -1;
    /* A walk over tets that are not Delaunay, or inverted in space, may circle: it ends after as many steps as a
     * straight line could at most need. */
    for (int step = 0; step < mesh->tet_count; step++) {
        const int *n = mesh->tets + 4 * (size_t)tet;
        int worst = -1, next;
        ndli_tet_weights(positions[n[0]], positions[n[1]], positions[n[2]], positions[n[3]], point, w);
        for (int c = 0; c < 4; c++)
            if (!(w[c] >= slack) && (worst < 0 || w[c] < w[worst]) &&
                (mesh->neighbours[4 * (size_t)tet + (size_t)c] != from || from < 0))
                worst = c;
        if (worst < 0)
            break;
        next = mesh->neighbours[4 * (size_t)tet + (size_t)worst];
        for (int c = 0; next < 0 && c < 4; c++) /* round a dent of the surface, if there is a way */
            if (c != worst && w[c] < slack && mesh->neighbours[4 * (size_t)tet + (size_t)c] != from)
                next = mesh->neighbours[4 * (size_t)tet + (size_t)c];
        if (next < 0)
            break;
        from = tet;
        tet = next;
    }
    if (weights)
        memcpy(weights, w, sizeof w);
    for (int c = 0; c < 4; c++)
        if (!(w[c] >= slack))
            return -1;
    return tet;
}

NDLI_API sb_mat3 ndli_topology_gradient(const ndli_topology *mesh, int tet)
{
    const int *n = mesh->tets + 4 * (size_t)tet;
    sb_mat3 material, space;
    for (int c = 0; c < 3; c++) {
        sb_vec3 a = sb_v3_sub(mesh->X[n[c + 1]], mesh->X[n[0]]), b = sb_v3_sub(mesh->x[n[c + 1]], mesh->x[n[0]]);
        material.m[0][c] = a.x, material.m[1][c] = a.y, material.m[2][c] = a.z;
        space.m[0][c] = b.x, space.m[1][c] = b.y, space.m[2][c] = b.z;
    }
    return sb_m3_mul(space, sb_m3_inverse(material));
}

/* How well a tet has kept its shape in space: 1 where it has only been turned, moved or scaled; inverted: <= 0. */
static sb_real ndli_topology_kept(const ndli_topology *t, int tet)
{
    sb_mat3 f = ndli_topology_gradient(t, tet);
    sb_real squares = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            squares += f.m[i][j] * f.m[i][j];
    squares /= 3;
    return squares > 0 ? sb_m3_det(f) / (squares * sb_sqrt(squares)) : 0;
}

static int ndli_topology_holds_point(const ndli_topology *t, int tet, sb_vec3 x)
{
    const int *n = t->tets + 4 * (size_t)tet;
    sb_vec3 a = t->x[n[0]], b = t->x[n[1]], c = t->x[n[2]], d = t->x[n[3]];
    return ndli_topology_det(x, b, c, d) >= 0 && ndli_topology_det(a, x, c, d) >= 0 &&
           ndli_topology_det(a, b, x, d) >= 0 && ndli_topology_det(a, b, c, x) >= 0;
}

NDLI_API int ndli_topology_find_in_space(const ndli_topology *mesh, sb_vec3 x, int start)
{
    int tet = ndli_topology_find(mesh, mesh->x, x, start, NULL);
    sb_real best = 0;
    if (tet >= 0 && ndli_topology_kept(mesh, tet) > 0)
        return tet;
    for (int t = 0; t < mesh->tet_end; t++) {
        sb_real kept =
            ndli_topology_is_tet(mesh, t) && ndli_topology_holds_point(mesh, t, x) ? ndli_topology_kept(mesh, t) : 0;
        if (kept > best) {
            best = kept;
            tet = t;
        }
    }
    return tet;
}

/* Where the segment p + s d crosses the triangle from its front (normal against d): s, or -1. */
static sb_real ndli_topology_cross(sb_vec3 p, sb_vec3 d, sb_vec3 a, sb_vec3 b, sb_vec3 c, sb_real w[3])
{
    sb_vec3 ab = sb_v3_sub(b, a), ac = sb_v3_sub(c, a), n = sb_v3_cross(ab, ac), ap = sb_v3_sub(p, a), q;
    sb_real den = -sb_v3_dot(d, n), slack = 64 * SB_EPSILON;
    if (!(den > 0))
        return -1;
    q = sb_v3_cross(ap, d);
    w[1] = sb_v3_dot(ac, q) / den;
    w[2] = -sb_v3_dot(ab, q) / den;
    w[0] = 1 - w[1] - w[2];
    if (w[0] < -slack || w[1] < -slack || w[2] < -slack)
        return -1;
    return sb_v3_dot(ap, n) / den;
}

NDLI_API int ndli_topology_hit(const ndli_topology *mesh, sb_vec3 from, sb_vec3 to, ndl_surface_hit *hit)
{
    sb_vec3 d = sb_v3_sub(to, from);
    int found = 0;
    if (!mesh || !hit || !sb_v3_is_finite(from) || !sb_v3_is_finite(to))
        return 0;
    for (int tet = 0; tet < mesh->tet_end; tet++) {
        const int *n = mesh->tets + 4 * (size_t)tet;
        static const int outward[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};
        for (int face = 0; n[0] >= 0 && face < 4; face++) {
            int a = n[outward[face][0]], b = n[outward[face][1]], c = n[outward[face][2]];
            sb_real w[3], along;
            if (mesh->neighbours[4 * (size_t)tet + (size_t)face] >= 0)
                continue;
            along = ndli_topology_cross(from, d, mesh->x[a], mesh->x[b], mesh->x[c], w);
            if (along < 0 || along > 1 || (found && along >= hit->along))
                continue;
            found = 1;
            hit->tet = tet;
            hit->face = face;
            hit->along = along;
            hit->X = sb_v3_madd(sb_v3_madd(sb_v3_scale(w[0], mesh->X[a]), w[1], mesh->X[b]), w[2], mesh->X[c]);
        }
    }
    return found;
}

/* ---- a change ---- */

enum { NDLI_TOUCHED = 1, NDLI_WAS_ALIVE = 2, NDLI_RELINK = 4, NDLI_DROPPED = 8 };

static void ndli_topology_affect(ndli_topology *t, int node, int was_alive)
{
    if (t->node_mark[node])
        return;
    t->node_mark[node] = (unsigned char)(was_alive ? NDLI_TOUCHED | NDLI_WAS_ALIVE : NDLI_TOUCHED);
    t->affected[t->affected_count++] = node;
}

/* To be called before a tet is changed, and after one is made. */
static void ndli_topology_touch(ndli_topology *t, int tet, int made, int relink)
{
    if (!t->tet_mark[tet]) {
        t->tet_mark[tet] = (unsigned char)(made ? NDLI_TOUCHED : NDLI_TOUCHED | NDLI_WAS_ALIVE);
        t->touched[t->touched_count++] = tet;
    }
    if (relink)
        t->tet_mark[tet] |= NDLI_RELINK;
    for (int c = 0; c < 4; c++)
        ndli_topology_affect(t, t->tets[4 * (size_t)tet + (size_t)c], 1);
}

NDLI_API void ndli_topology_begin(ndli_topology *mesh)
{
    mesh->touched_count = mesh->affected_count = mesh->change_count = 0;
    mesh->node_event_count = mesh->tet_event_count = 0;
    mesh->displaced_before_count = mesh->displaced_count;
    if (mesh->displaced_count)
        memcpy(mesh->displaced_before, mesh->displaced, (size_t)mesh->displaced_count * sizeof(int));
}

NDLI_API int ndli_topology_source(const ndli_topology *t, sb_vec3 X, int start, sb_real w[4])
{
    int tet = ndli_topology_find(t, t->X, X, start, w), best = start;
    sb_real most = -SB_REAL_MAX, sum = 0;
    for (int c = 0; tet < 0 && c < 4; c++) { /* a dent may have ended the walk: look about the start */
        for (int k = t->node_star[t->tets[4 * (size_t)start + (size_t)c]]; k >= 0; k = t->corner_next[k]) {
            const int *n = t->tets + 4 * (size_t)(k / 4);
            sb_real least;
            ndli_tet_weights(t->X[n[0]], t->X[n[1]], t->X[n[2]], t->X[n[3]], X, w);
            least = sb_min(sb_min(w[0], w[1]), sb_min(w[2], w[3]));
            if (least > most) {
                most = least;
                best = k / 4;
            }
        }
    }
    if (tet < 0) {
        const int *n = t->tets + 4 * (size_t)best;
        ndli_tet_weights(t->X[n[0]], t->X[n[1]], t->X[n[2]], t->X[n[3]], X, w);
    }
    for (int c = 0; c < 4; c++)
        sum += w[c] = sb_max(w[c], 0);
    for (int c = 0; c < 4; c++)
        w[c] /= sum;
    return tet < 0 ? best : tet;
}

NDLI_API int ndli_topology_plan(ndli_topology *mesh, int node, sb_vec3 X, int start)
{
    ndli_node_change *change = mesh->changes + mesh->change_count;
    int tet = ndli_topology_source(mesh, X, start, change->weights);
    change->node = node;
    change->created = node < 0;
    change->X = X;
    for (int c = 0; c < 4; c++)
        change->sources[c] = mesh->tets[4 * (size_t)tet + (size_t)c];
    return mesh->change_count++;
}

/* A slot comes into use or (made = 0) goes out of it; what it was is kept. */
static void ndli_topology_note_node(ndli_topology *t, int node, int made)
{
    ndli_node_event *event = t->node_events + t->node_event_count++;
    event->node = made ? node : ~node;
    event->owner = t->owner[node];
    event->flags = t->node_flags[node];
    event->X0 = t->X0[node];
}

static int ndli_topology_make_node(ndli_topology *t, sb_vec3 X)
{
    int node = t->free_node;
    if (node >= 0)
        t->free_node = t->node_star[node];
    else
        node = t->node_end++;
    t->node_count++;
    ndli_topology_note_node(t, node, 1);
    t->X[node] = t->X0[node] = X;
    t->owner[node] = t->node_star[node] = t->displaced_at[node] = -1;
    t->node_flags[node] = NDLI_NODE_ALIVE | NDLI_NODE_CREATED;
    ndli_topology_affect(t, node, 0);
    return node;
}

static void ndli_topology_drop_node(ndli_topology *t, int node)
{
    SB_ASSERT(t->node_star[node] < 0);
    ndli_topology_note_node(t, node, 0);
    t->node_flags[node] = 0;
    t->owner[node] = -1;
    t->X[node] = t->X0[node] = sb_v3(0, 0, 0);
    t->node_star[node] = t->free_node;
    t->free_node = node;
    t->node_count--;
}

/* A copy of a tet with another node at one corner. */
static int ndli_topology_make_tet(ndli_topology *t, int pattern, int corner, int node)
{
    int tet = t->free_tet;
    if (tet >= 0)
        t->free_tet = t->neighbours[4 * (size_t)tet];
    else
        tet = t->tet_end++;
    t->tet_count++;
    for (int c = 0; c < 4; c++)
        ndli_topology_join(t, 4 * tet + c, c == corner ? node : t->tets[4 * (size_t)pattern + (size_t)c]);
    t->regions[tet] = t->regions[pattern];
    t->parents[tet] = pattern;
    t->tet_events[t->tet_event_count++] = tet;
    ndli_topology_touch(t, tet, 1, 1);
    return tet;
}

static void ndli_topology_drop_tet(ndli_topology *t, int tet)
{
    ndli_topology_touch(t, tet, 0, 1);
    for (int c = 0; c < 4; c++)
        ndli_topology_leave(t, 4 * tet + c);
    memset(t->tets + 4 * (size_t)tet, -1, 4 * sizeof(int));
    t->neighbours[4 * (size_t)tet] = t->free_tet;
    t->free_tet = tet;
    t->tet_count--;
    t->tet_mark[tet] |= NDLI_DROPPED;
    t->tet_events[t->tet_event_count++] = ~tet;
}

static int ndli_topology_corner(const ndli_topology *t, int tet, int node)
{
    int c = 0;
    while (c < 3 && t->tets[4 * (size_t)tet + (size_t)c] != node)
        c++;
    return c;
}

static void ndli_topology_replace(ndli_topology *t, int tet, int old, int node)
{
    int corner = 4 * tet + ndli_topology_corner(t, tet, old);
    ndli_topology_touch(t, tet, 0, 1);
    ndli_topology_leave(t, corner);
    ndli_topology_join(t, corner, node);
}

NDLI_API int ndli_topology_cut(ndli_topology *mesh, const int *simplex, int size, int plan, int *groups)
{
    int node = ndli_topology_make_node(mesh, mesh->changes[plan].X), count = 0, mixed = 0;
    mesh->changes[plan].node = node;
    for (int k = mesh->node_star[simplex[0]]; k >= 0; k = mesh->corner_next[k])
        if (ndli_topology_holds(mesh, k / 4, simplex, size))
            groups[size * count++] = k / 4;
    for (int g = 0; g < count; g++) {
        int parent = groups[size * g];
        mixed |= mesh->regions[parent] != mesh->regions[groups[0]];
        ndli_topology_touch(mesh, parent, 0, 1);
        for (int j = 1; j < size; j++)
            groups[size * g + j] =
                ndli_topology_make_tet(mesh, parent, ndli_topology_corner(mesh, parent, simplex[j]), node);
        ndli_topology_replace(mesh, parent, simplex[0], node);
    }
    if (mixed)
        mesh->node_flags[node] |= NDLI_NODE_INTERFACE;
    return count;
}

NDLI_API void ndli_topology_mend(ndli_topology *mesh, int node, const int *simplex, int size, const int *groups,
                                 int count)
{
    for (int g = count - 1; g >= 0; g--) {
        for (int j = size - 1; j > 0; j--)
            ndli_topology_drop_tet(mesh, groups[size * g + j]);
        ndli_topology_replace(mesh, groups[size * g], node, simplex[0]);
    }
    ndli_topology_drop_node(mesh, node);
}

/* Keeps the list of nodes that are not at their own place. */
static void ndli_topology_note_displaced(ndli_topology *t, int node)
{
    int is = memcmp(t->X + node, t->X0 + node, sizeof(sb_vec3)) != 0 && !(t->node_flags[node] & NDLI_NODE_CREATED);
    int at = t->displaced_at[node];
    if (is && at < 0) {
        t->displaced_at[node] = t->displaced_count;
        t->displaced[t->displaced_count++] = node;
    } else if (!is && at >= 0) {
        int last = t->displaced[--t->displaced_count];
        t->displaced[at] = last;
        t->displaced_at[last] = at;
        t->displaced_at[node] = -1;
    }
}

NDLI_API void ndli_topology_move(ndli_topology *mesh, int plan)
{
    int node = mesh->changes[plan].node;
    for (int k = mesh->node_star[node]; k >= 0; k = mesh->corner_next[k])
        ndli_topology_touch(mesh, k / 4, 0, 0);
    mesh->X[node] = mesh->changes[plan].X;
    ndli_topology_note_displaced(mesh, node);
}

static void ndli_topology_report(ndli_topology *t, ndli_topology_change *change)
{
    memset(change, 0, sizeof *change);
    for (int i = 0; i < t->touched_count; i++) {
        int tet = t->touched[i];
        if ((t->tet_mark[tet] & (NDLI_WAS_ALIVE | NDLI_DROPPED)) == NDLI_WAS_ALIVE)
            t->changed[change->changed_count++] = tet;
    }
    change->changed = t->changed;
    change->node_events = t->node_events;
    change->tet_events = t->tet_events;
    change->node_event_count = t->node_event_count;
    change->tet_event_count = t->tet_event_count;
    change->nodes = t->changes;
    change->node_count = t->change_count;
}

NDLI_API void ndli_topology_end(ndli_topology *mesh, ndli_topology_change *change)
{
    for (int i = 0; i < mesh->touched_count; i++)
        if (mesh->tets[4 * (size_t)mesh->touched[i]] >= 0) {
            ndli_topology_measure(mesh, mesh->touched[i]);
            if (mesh->tet_mark[mesh->touched[i]] & NDLI_RELINK)
                ndli_topology_link(mesh, mesh->touched[i]);
        }
    ndli_topology_report(mesh, change);
    for (int i = 0; i < mesh->touched_count; i++)
        mesh->tet_mark[mesh->touched[i]] = 0;
    for (int i = 0; i < mesh->affected_count; i++)
        mesh->node_mark[mesh->affected[i]] = 0;
}

/* The list of displaced nodes as another one says; their places in it with it. */
static void ndli_topology_set_displaced(ndli_topology *t, const int *list, int count)
{
    for (int n = 0; n < t->node_end; n++)
        t->displaced_at[n] = -1;
    for (int i = 0; i < count; i++) {
        t->displaced[i] = list[i];
        t->displaced_at[list[i]] = i;
    }
    t->displaced_count = count;
}

NDLI_API void ndli_topology_take_back(ndli_topology *mesh, const sb_body *body)
{
    for (int i = mesh->node_event_count - 1; i >= 0; i--) {
        const ndli_node_event *event = mesh->node_events + i;
        int node = event->node < 0 ? ~event->node : event->node;
        mesh->owner[node] = event->owner;
        mesh->node_flags[node] = event->flags;
        mesh->X0[node] = event->X0;
    }
    ndli_topology_read_again(mesh, body);
    ndli_topology_set_displaced(mesh, mesh->displaced_before, mesh->displaced_before_count);
}

/* ---- measures and checks ---- */

/* Extreme cosines of a tet's six dihedral angles. */
static void ndli_topology_cosines(const ndli_topology *t, int tet, sb_real *low, sb_real *high)
{
    const int *n = t->tets + 4 * (size_t)tet;
    sb_vec3 a = t->X[n[0]], b = t->X[n[1]], c = t->X[n[2]], d = t->X[n[3]], normal[4];
    normal[0] = sb_v3_cross(sb_v3_sub(c, b), sb_v3_sub(d, b));
    normal[1] = sb_v3_cross(sb_v3_sub(d, a), sb_v3_sub(c, a));
    normal[2] = sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(d, a));
    normal[3] = sb_v3_cross(sb_v3_sub(c, a), sb_v3_sub(b, a));
    for (int i = 0; i < 4; i++)
        normal[i] = sb_v3_scale(1 / sb_v3_norm(normal[i]), normal[i]);
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < i; j++) {
            sb_real cosine = -sb_v3_dot(normal[i], normal[j]);
            *low = sb_min(*low, cosine);
            *high = sb_max(*high, cosine);
        }
}

NDLI_API void ndli_topology_quality(const ndli_topology *mesh, sb_real *worst_quality, sb_real *min_dihedral,
                                    sb_real *max_dihedral)
{
    sb_real worst = 1, low = 1, high = -1, degrees = (sb_real)57.295779513082323;
    if (!mesh)
        return;
    for (int t = 0; t < mesh->tet_end; t++) {
        if (mesh->tets[4 * (size_t)t] < 0)
            continue;
        worst = sb_min(worst, mesh->qualities[t]);
        if (min_dihedral || max_dihedral)
            ndli_topology_cosines(mesh, t, &low, &high);
    }
    if (worst_quality)
        *worst_quality = worst;
    if (min_dihedral)
        *min_dihedral = degrees * sb_acos(high);
    if (max_dihedral)
        *max_dihedral = degrees * sb_acos(low);
}

static sb_result ndli_topology_check_tet(const ndli_topology *t, int tet, sb_error *error)
{
    for (int c = 0; c < 4; c++) {
        int corner = 4 * tet + c, node = t->tets[corner], other = t->neighbours[corner], nodes[3], back = 0;
        if (node < 0 || node >= t->node_end || !t->node_flags[node])
            return sbi_fail_element(error, SB_ERROR_MESH, tet, "tet %d has a node that is not in use", tet);
        if (t->corner_prev[corner] >= 0 ? t->corner_next[t->corner_prev[corner]] != corner
                                        : t->node_star[node] != corner)
            return sbi_fail_element(error, SB_ERROR_MESH, tet, "tet %d is not in the ring of node %d", tet, node);
        if (other < 0)
            continue;
        ndli_topology_face(t, tet, c, nodes);
        for (int k = 0; ndli_topology_is_tet(t, other) && k < 4; k++)
            back |= t->neighbours[4 * (size_t)other + (size_t)k] == tet;
        if (!back || !ndli_topology_holds(t, other, nodes, 3))
            return sbi_fail_element(error, SB_ERROR_MESH, tet, "tet %d and its neighbour %d disagree", tet, other);
    }
    if (t->tet_mark[tet] || !(t->qualities[tet] > 0))
        return sbi_fail_element(error, SB_ERROR_MESH, tet, "tet %d is flat, inverted or marked", tet);
    return SB_OK;
}

NDLI_API sb_result ndli_topology_check(const ndli_topology *mesh, sb_error *error)
{
    sb_result result = SB_OK;
    int tets = 0, nodes = 0, corners = 0;
    if (!mesh || !mesh->block)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "no mesh");
    for (int t = 0; result == SB_OK && t < mesh->tet_end; t++)
        if (mesh->tets[4 * (size_t)t] >= 0) {
            tets++;
            result = ndli_topology_check_tet(mesh, t, error);
        }
    for (int n = 0; result == SB_OK && n < mesh->node_end; n++)
        if (mesh->node_flags[n]) {
            nodes++;
            for (int k = mesh->node_star[n]; k >= 0 && corners <= 4 * mesh->tet_count; k = mesh->corner_next[k])
                corners++;
        }
    if (result == SB_OK && (tets != mesh->tet_count || nodes != mesh->node_count || corners != 4 * tets))
        result = sbi_fail(error, SB_ERROR_MESH, "counts disagree: %d tets, %d nodes, %d corners", tets, nodes, corners);
    return result;
}

NDLI_API int ndli_topology_is_original(const ndli_topology *mesh)
{
    if (!mesh || mesh->displaced_count)
        return 0;
    for (int n = 0; n < mesh->node_end; n++)
        if (mesh->node_flags[n] & NDLI_NODE_CREATED)
            return 0;
    return 1;
}

/* ---- undo and state ---- */

NDLI_API void ndli_topology_counts(const ndli_topology *mesh, int *counts)
{
    counts[0] = mesh->node_end;
    while (counts[0] > 0 && !mesh->node_flags[counts[0] - 1])
        counts[0]--;
    counts[1] = mesh->displaced_count;
    counts[2] = mesh->original_nodes, counts[3] = mesh->original_tets;
}

NDLI_API void ndli_topology_walk(ndli_topology *mesh, const int *counts, ndli_image *image)
{
    size_t nodes = (size_t)counts[0];
    ndli_image_part(image, mesh->X0, nodes, sizeof(sb_vec3));
    ndli_image_part(image, mesh->owner, nodes, sizeof(int));
    ndli_image_part(image, mesh->node_flags, nodes, 1);
    ndli_image_part(image, mesh->displaced, (size_t)counts[1], sizeof(int));
}

NDLI_API void ndli_topology_recall(ndli_topology *mesh, const int *counts, const sb_body *body)
{
    int end = sbi_body_node_slots(body).end;
    mesh->original_nodes = counts[2];
    mesh->original_tets = counts[3];
    for (int n = counts[0]; n < end; n++) {
        mesh->node_flags[n] = 0;
        mesh->owner[n] = -1;
        mesh->X0[n] = sb_v3(0, 0, 0);
    }
    ndli_topology_read_again(mesh, body);
    for (int n = 0; n < mesh->node_end; n++)
        mesh->displaced_at[n] = -1;
    mesh->displaced_count = counts[1];
    for (int i = 0; i < counts[1]; i++)
        mesh->displaced_at[mesh->displaced[i]] = i;
}

NDLI_API sb_result ndli_topology_check_memory(const ndli_topology *mesh, const int *counts, const unsigned char *in,
                                              int max_owner, sb_error *error)
{
    enum {
        KNOWN = NDLI_NODE_ALIVE | NDLI_NODE_BOUNDARY | NDLI_NODE_INTERFACE | NDLI_NODE_FIXED | NDLI_NODE_CREATED |
                NDLI_NODE_NEEDLE
    };
    size_t nodes = (size_t)counts[0];
    const unsigned char *owners = in + ndli_image_room(nodes * sizeof(sb_vec3));
    const unsigned char *flags = owners + ndli_image_room(nodes * sizeof(int));
    const unsigned char *list = flags + ndli_image_room(nodes);
    int displaced = 0;
    for (int n = 0; n < counts[0]; n++) {
        int owner = ndli_image_int(owners, (size_t)n), away;
        sb_vec3 X0;
        memcpy(&X0, in + (size_t)n * sizeof X0, sizeof X0);
        away = flags[n] && !(flags[n] & NDLI_NODE_CREATED) && memcmp(&X0, mesh->X + n, sizeof X0) != 0;
        displaced += away;
        if (!sb_v3_is_finite(X0))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, n, "the saved place of node %d is not finite", n);
        if ((flags[n] & ~KNOWN) || (flags[n] != 0) != (mesh->node_star[n] >= 0 && n < mesh->node_end) || owner < -1 ||
            owner >= max_owner || (flags[n] && !(flags[n] & NDLI_NODE_ALIVE)))
            return sbi_fail_node(error, SB_ERROR_FORMAT, n, "the saved remesher is damaged at node %d", n);
    }
    for (int i = 0; i < counts[1]; i++) {
        int n = ndli_image_int(list, (size_t)i);
        sb_vec3 X0;
        if (n < 0 || n >= counts[0])
            return sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher is damaged: it has displaced node %d", n);
        memcpy(&X0, in + (size_t)n * sizeof X0, sizeof X0);
        for (int k = 0; k < i; k++)
            displaced -= ndli_image_int(list, (size_t)k) == n; /* twice: the sum below is wrong then */
        displaced -= flags[n] && !(flags[n] & NDLI_NODE_CREATED) && memcmp(&X0, mesh->X + n, sizeof X0) != 0;
    }
    return displaced == 0 ? SB_OK
                          : sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher's list of displaced nodes is damaged");
}

NDLI_API int ndli_topology_first_tet(const ndli_topology *mesh, int i, int j)
{
    for (int k = mesh->node_star[i]; k >= 0; k = mesh->corner_next[k])
        if (ndli_topology_holds(mesh, k / 4, &j, 1))
            return k / 4;
    return -1;
}

/* ==== src/needle/rod_state.c ==== */
/* rod_state: saves what a rod is at, and brings it back to the last bit. */

#include <string.h>


static int ndli_state_is_flag(int value) { return value == 0 || value == 1; }

static const char ndli_rod_magic[9] = "NDLROD\x1a\x1a";

typedef struct ndli_rod_head {
    double stretch, bending[2], torsion, line_density, tolerance; /* the make */
    double gravity[3], damping_stretch, damping_bending, base_director[3], energy_before;
    int order, max_newton, node_count, plain, base_director_set, energy_monitored, grips;
    int none; /* fills the head up to whole doubles */
} ndli_rod_head;

static void ndli_rod_fill_head(const ndl_rod *rod, ndli_rod_head *h)
{
    memset(h, 0, sizeof *h);
    h->stretch = rod->stretch, h->bending[0] = rod->bending[0], h->bending[1] = rod->bending[1];
    h->torsion = rod->torsion, h->line_density = rod->line_density, h->tolerance = rod->tolerance;
    h->gravity[0] = rod->gravity.x, h->gravity[1] = rod->gravity.y, h->gravity[2] = rod->gravity.z;
    h->damping_stretch = rod->damping_stretch, h->damping_bending = rod->damping_bending;
    h->base_director[0] = rod->base_director.x, h->base_director[1] = rod->base_director.y;
    h->base_director[2] = rod->base_director.z;
    h->energy_before = rod->energy_before;
    h->order = NDLI_IMAGE_ORDER;
    h->max_newton = rod->max_newton;
    h->node_count = rod->node_count;
    h->plain = rod->plain;
    h->base_director_set = rod->base_director_set;
    h->energy_monitored = rod->energy_monitored;
    h->grips = rod->grips;
}

static void ndli_rod_take_head(ndl_rod *rod, const ndli_rod_head *h)
{
    rod->gravity = ndli_v(h->gravity[0], h->gravity[1], h->gravity[2]);
    rod->damping_stretch = h->damping_stretch, rod->damping_bending = h->damping_bending;
    rod->base_director = ndli_v(h->base_director[0], h->base_director[1], h->base_director[2]);
    rod->energy_before = h->energy_before;
    rod->node_count = h->node_count;
    rod->plain = h->plain;
    rod->base_director_set = h->base_director_set;
    rod->energy_monitored = h->energy_monitored;
    rod->grips = h->grips;
}

/* Returns where the bytes that are no numbers begin. */
static size_t ndli_rod_walk(ndl_rod *rod, int node_count, ndli_image *image)
{
    ndli_v3 *node_vectors[] = {rod->x, rod->v, rod->a, rod->target, rod->target_velocity, rod->force, rod->reaction};
    ndli_v3 *edge_vectors[] = {rod->director, rod->tangent};
    double *edge_reals[] = {rod->theta, rod->rest_length, rod->turn,   rod->torque,
                            rod->grip,  rod->grip_limit,  rod->anchor, rod->reaction_torque};
    size_t n = (size_t)node_count, flags;
    for (size_t i = 0; i < sizeof node_vectors / sizeof *node_vectors; i++)
        ndli_image_part(image, node_vectors[i], n, sizeof(ndli_v3));
    for (size_t i = 0; i < sizeof edge_vectors / sizeof *edge_vectors; i++)
        ndli_image_part(image, edge_vectors[i], n - 1, sizeof(ndli_v3));
    for (size_t i = 0; i < sizeof edge_reals / sizeof *edge_reals; i++)
        ndli_image_part(image, edge_reals[i], n - 1, sizeof(double));
    ndli_image_part(image, rod->mass, n, sizeof(double));
    ndli_image_part(image, rod->cell, n, sizeof(double));
    ndli_image_part(image, rod->rest_bend, n, 2 * sizeof(double));
    flags = image->used;
    ndli_image_part(image, rod->held, n, 1);
    ndli_image_part(image, rod->has_velocity, n, 1);
    ndli_image_part(image, rod->turn_held, n - 1, 1);
    return flags;
}

static size_t ndli_rod_measure(ndl_rod *rod, int node_count, size_t *flags)
{
    ndli_image image;
    memset(&image, 0, sizeof image);
    image.used = sizeof(ndli_rod_head);
    *flags = ndli_rod_walk(rod, node_count, &image);
    return image.used;
}

NDLI_API size_t ndli_rod_snapshot_size(const ndl_rod *rod, int node_count)
{
    ndl_rod view = *rod;
    size_t flags;
    return ndli_rod_measure(&view, node_count, &flags);
}

NDLI_API void ndli_rod_snapshot(const ndl_rod *rod, void *buffer)
{
    ndl_rod view = *rod;
    ndli_rod_head head;
    ndli_image image;
    memset(&image, 0, sizeof image);
    image.out = (unsigned char *)buffer;
    ndli_rod_fill_head(rod, &head);
    ndli_image_part(&image, &head, 1, sizeof head);
    ndli_rod_walk(&view, head.node_count, &image);
}

NDLI_API void ndli_rod_rewind(ndl_rod *rod, const void *buffer)
{
    ndli_rod_head head;
    ndli_image image;
    memset(&image, 0, sizeof image);
    image.in = (const unsigned char *)buffer;
    ndli_image_part(&image, &head, 1, sizeof head);
    ndli_rod_take_head(rod, &head);
    ndli_rod_walk(rod, head.node_count, &image);
    ndli_rod_publish(rod);
}

static sb_result ndli_rod_check_head(const ndl_rod *rod, const ndli_rod_head *head, sb_error *error)
{
    ndli_rod_head own;
    ndli_rod_fill_head(rod, &own);
    if (head->order != NDLI_IMAGE_ORDER)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the saved rod is of a machine with another order of bytes");
    if (memcmp(&own, head, 6 * sizeof(double)) != 0 || own.max_newton != head->max_newton)
        return sbi_fail(error, SB_ERROR_STATE, "the saved rod was made from another def");
    if (head->node_count > rod->capacity)
        return sbi_fail(error, SB_ERROR_STATE, "the saved rod has %d nodes, this one room for %d", head->node_count,
                        rod->capacity);
    if (head->node_count < 2 || head->grips < 0 || head->grips >= head->node_count ||
        !ndli_state_is_flag(head->plain) || !ndli_state_is_flag(head->base_director_set) ||
        !ndli_state_is_flag(head->energy_monitored))
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved rod has counts or flags out of their range");
    return SB_OK;
}

NDLI_API sb_result ndli_rod_check(const ndl_rod *rod, const unsigned char *in, size_t size, size_t *used, int *nodes,
                                  sb_error *error)
{
    ndl_rod view = *rod;
    ndli_rod_head head;
    size_t flags;
    sb_result result;
    if (size < sizeof head)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved rod ends in its head");
    memcpy(&head, in, sizeof head);
    result = ndli_rod_check_head(rod, &head, error);
    if (result != SB_OK)
        return result;
    *used = ndli_rod_measure(&view, head.node_count, &flags);
    *nodes = head.node_count;
    if (*used > size)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved rod ends before its %d nodes do", head.node_count);
    for (size_t at = 0; at < flags; at += sizeof(double)) {
        double value;
        memcpy(&value, in + at, sizeof value);
        if ((at < 15 * sizeof(double) || at >= sizeof head) && value - value != 0)
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "the saved rod holds a number that is not finite");
    }
    return SB_OK;
}

NDLI_API void ndli_rod_put(const ndl_rod *rod, sbi_state_out *out)
{
    ndl_rod view = *rod;
    ndli_rod_head head;
    ndli_image image;
    memset(&image, 0, sizeof image);
    image.state = out;
    ndli_rod_fill_head(rod, &head);
    ndli_image_part(&image, &head, 1, sizeof head);
    ndli_rod_walk(&view, head.node_count, &image);
}

static sb_result ndli_rod_check_image(const ndl_rod *rod, const void *buffer, size_t size, sb_error *error)
{
    size_t told, used;
    int nodes;
    sb_result result = ndli_image_check(buffer, size, ndli_rod_magic, "rod", error);
    if (result != SB_OK)
        return result;
    told = (size_t)sbi_get_bytes((const unsigned char *)buffer + 16, 8) - SBI_IMAGE_HEAD - SBI_IMAGE_TAIL;
    result = ndli_rod_check(rod, (const unsigned char *)buffer + SBI_IMAGE_HEAD, told, &used, &nodes, error);
    if (result == SB_OK && used != told)
        result = sbi_fail(error, SB_ERROR_FORMAT, "the saved rod goes on behind its nodes");
    return result;
}

NDL_API size_t ndl_rod_state_size(const ndl_rod *rod)
{
    return rod ? ndli_rod_snapshot_size(rod, rod->node_count) + SBI_IMAGE_HEAD + SBI_IMAGE_TAIL : 0;
}

NDL_API sb_result ndl_rod_save(const ndl_rod *rod, void *buffer, size_t size, sb_error *error)
{
    size_t needed = ndl_rod_state_size(rod);
    if (!rod || !buffer)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s is NULL", rod ? "buffer" : "rod");
    if (size < needed)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the state of this rod takes %lu bytes, not %lu",
                        (unsigned long)needed, (unsigned long)size);
    ndli_rod_snapshot(rod, (unsigned char *)buffer + SBI_IMAGE_HEAD);
    sbi_image_seal((unsigned char *)buffer, needed, ndli_rod_magic, NDLI_IMAGE_VERSION);
    return SB_OK;
}

NDL_API sb_result ndl_rod_load(ndl_rod *rod, const void *buffer, size_t size, sb_error *error)
{
    sb_result result;
    if (!rod)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "rod is NULL");
    result = ndli_rod_check_image(rod, buffer, size, error);
    if (result == SB_OK)
        ndli_rod_rewind(rod, (const unsigned char *)buffer + SBI_IMAGE_HEAD);
    return result;
}

/* ==== src/needle/remesh_private.h ==== */
/* remesh_private: what is inside a remesher. Floor 6, internal: remesh.c works on it, remesh_state.c keeps it. */
#ifndef NDL_REMESH_PRIVATE_H
#define NDL_REMESH_PRIVATE_H


enum { NDLI_FINALISTS = 6 }; /* candidates that are smoothed before they are compared */

/* A split that can be undone; its tets are pool[first ...], `size` per tet that was cut. */
typedef struct ndli_split {
    int node, size, simplex[4];
    int first, count;
} ndli_split;

typedef struct ndli_needle {
    int *nodes, count, node_capacity; /* entry first */
    ndli_split *stack;
    int depth, stack_capacity;
    int undone; /* splits that the change under way has taken back */
    int *pool, pool_count, pool_capacity;
} ndli_needle;

typedef struct ndli_patch_tet {
    int nodes[4];
    int slot; /* -1: stood before the top split, and would again without it */
    int skin; /* bit c: the face opposite node c lies on the surface */
    sb_real quality;
} ndli_patch_tet;

typedef struct ndli_patch {
    ndli_patch_tet *tets;
    int count;
} ndli_patch;

typedef struct ndli_qualities {
    sb_real *values, least;
    int count;
} ndli_qualities;

typedef struct ndli_candidate {
    int simplex[4], size; /* size 1: snap */
    int undo, drops_tip;  /* the top split is undone first; the old tip stays in the tissue, but not on the needle */
    int slid, slid_moves; /* node that may slide along, or -1 */
    sb_vec3 X, slid_X;
    ndli_qualities created, removed;
} ndli_candidate;

/* The patch and a ring about it after one candidate, on which smoothing is tried. Nodes are numbered by the table
 * that all candidates of an operation share; the node to be made comes after it. */
typedef struct ndli_draft {
    int *tets, tet_count; /* [4]; those of the core first */
    int core_count;
    sb_real *qualities;
    sb_vec3 *X;             /* [table_count + 1] */
    int *star_start, *star; /* tets of a node: star[star_start[i] .. star_start[i + 1]) */
    unsigned char *is_free;
    int *moved, moved_count; /* nodes not where the candidate had them */
} ndli_draft;

typedef struct ndli_node_move {
    int node;
    sb_vec3 X;
} ndli_node_move;

/* A split that is undone: its node, and the corners that it was between. */
typedef struct ndli_leaving {
    int node, size, simplex[4];
} ndli_leaving;

struct ndl_remesh {
    ndl_remesh_def def;
    ndli_topology topology, *mesh; /* mesh: that topology */
    sb_body *body;
    int listener;          /* its number at the body */
    int own;               /* 1: the change that the body makes is ours */
    int stale;             /* 1: the body has got another mesh, which is not read yet */
    int joined;            /* 1: it is a part of the body's state */
    ndl_remesh *staged;    /* what a saved state that passed its checks will make of this; else NULL */
    ndli_leaving *leaving; /* nodes that the change under way takes out */
    int leaving_count, leaving_capacity;
    ndli_needle *needles;
    int release_cursor;
    ndl_remesh_info info;

    int needle, conflict; /* of the call under way; element of another needle that stood in the way, or -1 */
    int capacity;         /* of the patch */
    ndli_patch here, undone;
    int core_count;             /* of here: the tets that candidates may change; after them those that smoothing may */
    int *table, table_count;    /* nodes of the patch */
    unsigned char *table_whole; /* 1: all its tets are in the patch */
    ndli_draft draft;
    int *moving, moving_count;                   /* [4] nodes of a candidate's tets about its sliding node */
    ndli_candidate final[NDLI_FINALISTS], trial; /* best first */
    int final_count;
    sb_real *rating, *best_rating; /* qualities of a draft, worst first */
    ndli_node_move *moves;         /* what the winner's draft smoothed */
    int move_count;
    sb_real outcome; /* least quality about the tip that the winner leaves; that of now: */
    sb_real before;
    sb_real enough;       /* an operation that leaves less than this, and than before, fails; usually 0 */
    ndli_qualities taken; /* what undoing the top split removes */
    sb_real *sorted[2];
    int *groups, *kept; /* tets of the split that is made, and of the one that is undone for it */
    void *scratch;
};

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
SB_INLINE int ndli_remesh_has(const int nodes[4], int node)
{
    return nodes[0] == node || nodes[1] == node || nodes[2] == node || nodes[3] == node;
}

SB_INLINE int ndli_remesh_holds(const int nodes[4], const int *simplex, int size)
{
    for (int i = 0; i < size; i++)
        if (!ndli_remesh_has(nodes, simplex[i]))
            return 0;
    return 1;
}

/* ---- remesh_state.c ---- */

/* Memory for a needle of so many nodes, splits and pool entries; what it has stays. 0: there is none. */
NDLI_API int ndli_remesh_make_room(ndl_remesh *r, ndli_needle *needle, const int counts[3]);
/* Frees what it knows of mesh and needles. Safe on NULL. */
NDLI_API void ndli_remesh_free_knowledge(ndl_remesh *r);

/* What the ints of a command begin with; then the needle, and what the call returned. */
typedef enum ndli_remesh_command {
    NDLI_COMMAND_PUNCTURE = 1,  /* and tet, face; along, X, slip */
    NDLI_COMMAND_PENETRATE = 2, /* X */
    NDLI_COMMAND_RETRACT = 3,   /* X */
    NDLI_COMMAND_WITHDRAW = 4,
    NDLI_COMMAND_MADE = 5, /* the remesher was created, or destroyed */
    NDLI_COMMAND_GONE = 6
} ndli_remesh_command;

typedef sb_result (*ndli_remesh_replay)(void *user, const int *ints, size_t int_count, const sb_real *reals,
                                        size_t real_count, sb_error *error);
/* The remesher joins the state and the recording of its body. */
NDLI_API sb_result ndli_remesh_join(ndl_remesh *r, ndli_remesh_replay replay, sb_error *error);
NDLI_API void ndli_remesh_leave(ndl_remesh *r);
/* Between these a call changes the body, which its recording then holds as one command of the remesher; ints NULL: it
 * is not told, as calls with numbers that are none are not: they change nothing. */
NDLI_API void ndli_remesh_hush(ndl_remesh *r);
NDLI_API void ndli_remesh_tell(ndl_remesh *r, const int *ints, size_t int_count, const sb_real *reals,
                               size_t real_count);
NDLI_API void ndli_remesh_tell_puncture(ndl_remesh *r, int needle, const ndl_surface_hit *hit, sb_real slip,
                                        sb_result result);
NDLI_API void ndli_remesh_tell_move(ndl_remesh *r, int needle, sb_vec3 X, int forward, sb_result result);
NDLI_API void ndli_remesh_tell_withdraw(ndl_remesh *r, int needle, sb_result result);
#endif

#endif /* NDL_REMESH_PRIVATE_H */

/* ==== src/needle/remesh_state.c ==== */
/* remesh_state: what a remesher knows: its memory, in undo, in the saved state of its body and in its recording. */

#include <limits.h>
#include <string.h>


/* ---- memory ---- */

static int ndli_remesh_grow(ndl_remesh *r, void **array, int *capacity, int used, int needed, size_t size)
{
    size_t room = (size_t)needed + (size_t)needed / 2;
    void *grown;
    if (needed <= *capacity)
        return 1;
    grown = sbi_alloc(&r->def.allocator, room, size);
    if (!grown)
        return 0;
    if (used)
        memcpy(grown, *array, (size_t)used * size);
    sbi_free(&r->def.allocator, *array);
    *array = grown;
    *capacity = (int)room;
    return 1;
}

NDLI_API int ndli_remesh_make_room(ndl_remesh *r, ndli_needle *needle, const int counts[3])
{
    void *nodes = needle->nodes, *stack = needle->stack, *pool = needle->pool, *leaving = r->leaving;
    int splits = 0, good = ndli_remesh_grow(r, &nodes, &needle->node_capacity, needle->count, counts[0], sizeof(int));
    needle->nodes = (int *)nodes;
    good = good && ndli_remesh_grow(r, &stack, &needle->stack_capacity, needle->depth, counts[1], sizeof(ndli_split));
    needle->stack = (ndli_split *)stack;
    good = good && ndli_remesh_grow(r, &pool, &needle->pool_capacity, needle->pool_count, counts[2], sizeof(int));
    needle->pool = (int *)pool;
    for (int i = 0; i < r->def.max_needles; i++)
        splits += r->needles[i].stack_capacity;
    good = good && ndli_remesh_grow(r, &leaving, &r->leaving_capacity, 0, splits, sizeof(ndli_leaving));
    r->leaving = (ndli_leaving *)leaving;
    return good;
}

NDLI_API void ndli_remesh_free_knowledge(ndl_remesh *r)
{
    if (!r)
        return;
    for (int i = 0; r->needles && i < r->def.max_needles; i++) {
        sbi_free(&r->def.allocator, r->needles[i].nodes);
        sbi_free(&r->def.allocator, r->needles[i].stack);
        sbi_free(&r->def.allocator, r->needles[i].pool);
    }
    sbi_free(&r->def.allocator, r->needles);
    sbi_free(&r->def.allocator, r->leaving);
    ndli_topology_free(&r->topology);
}

/* ---- the image ---- */

typedef struct ndli_remesh_head {
    double smooth_below, release_above, entry_slip;
    uint64_t mesh; /* hash of the mesh; 0 in snapshots */
    int order, max_needles, interfaces, max_smoothed, release_cursor;
    int stale; /* 1: the image ends here; nothing is known of the mesh that the body has got from others */
} ndli_remesh_head;

/* Free slots at the end do not count: they may have been merged. */
static uint64_t ndli_remesh_hash_mesh(const ndli_topology *mesh)
{
    size_t nodes = (size_t)mesh->node_end, tets = (size_t)mesh->tet_end;
    uint64_t hash;
    while (nodes > 0 && !mesh->node_flags[nodes - 1])
        nodes--;
    while (tets > 0 && mesh->tets[4 * (tets - 1)] < 0)
        tets--;
    hash = ndli_image_hash(nodes, mesh->tets, tets * 4 * sizeof(int));
    return ndli_image_hash(hash, mesh->X, nodes * sizeof(sb_vec3));
}

static void ndli_remesh_fill_head(const ndl_remesh *r, ndli_remesh_head *h)
{
    memset(h, 0, sizeof *h);
    h->smooth_below = (double)r->def.smooth_below;
    h->release_above = (double)r->def.release_above;
    h->entry_slip = (double)r->def.entry_slip;
    h->order = NDLI_IMAGE_ORDER;
    h->max_needles = r->def.max_needles;
    h->interfaces = (int)r->def.interfaces;
    h->max_smoothed = r->def.max_smoothed;
    h->release_cursor = r->stale ? 0 : r->release_cursor;
    h->stale = r->stale;
}

/* A split's simplex in four places, those that it does not use 0. */
static void ndli_remesh_walk_split(ndli_split *split, ndli_image *image)
{
    ndli_split whole;
    memset(&whole, 0, sizeof whole);
    if (split && !image->in) {
        whole = *split;
        for (int i = whole.size; i < 4; i++)
            whole.simplex[i] = 0;
    }
    ndli_image_part(image, &whole, 1, sizeof whole);
    if (image->in)
        *split = whole;
}

/* counts: [3] nodes, splits, pool */
static void ndli_remesh_walk_needle(ndli_needle *needle, const int *counts, ndli_image *image)
{
    ndli_image_part(image, needle->nodes, (size_t)counts[0], sizeof(int));
    for (int i = 0; i < counts[1]; i++) /* measuring: there may be no stack */
        ndli_remesh_walk_split(needle->stack ? needle->stack + i : NULL, image);
    ndli_image_part(image, needle->pool, (size_t)counts[2], sizeof(int));
}

/* Measures or writes. */
static void ndli_remesh_write(const ndl_remesh *r, uint64_t mesh, ndli_image *image)
{
    ndli_remesh_head head;
    ndli_topology topology = *r->mesh;
    int counts[NDLI_TOPOLOGY_COUNTS];
    ndli_remesh_fill_head(r, &head);
    head.mesh = mesh;
    ndli_image_part(image, &head, 1, sizeof head);
    if (r->stale)
        return;
    ndli_topology_counts(&topology, counts);
    ndli_image_part(image, counts, NDLI_TOPOLOGY_COUNTS, sizeof(int));
    ndli_topology_walk(&topology, counts, image);
    for (int i = 0; i < r->def.max_needles; i++) {
        int sizes[4] = {r->needles[i].count, r->needles[i].depth, r->needles[i].pool_count, 0};
        ndli_image_part(image, sizes, 4, sizeof(int));
        ndli_remesh_walk_needle(r->needles + i, sizes, image);
    }
}

NDLI_API size_t ndli_remesh_snapshot_size(const ndl_remesh *r)
{
    ndli_image image;
    memset(&image, 0, sizeof image);
    ndli_remesh_write(r, 0, &image);
    return image.used;
}

NDLI_API size_t ndli_remesh_snapshot_room(const ndl_remesh *r)
{
    ndli_topology topology = *r->mesh;
    ndli_image image;
    int counts[NDLI_TOPOLOGY_COUNTS] = {0, 0, 0, 0};
    size_t sum;
    memset(&image, 0, sizeof image);
    counts[0] = counts[1] = topology.node_capacity;
    ndli_topology_walk(&topology, counts, &image);
    sum = ndli_image_room(sizeof(ndli_remesh_head)) + ndli_image_room(sizeof counts) + image.used;
    for (int i = 0; i < r->def.max_needles; i++) {
        const ndli_needle *needle = r->needles + i;
        sum += ndli_image_room(4 * sizeof(int)) + ndli_image_room((size_t)needle->node_capacity * sizeof(int)) +
               ndli_image_room((size_t)needle->stack_capacity * sizeof(ndli_split)) +
               ndli_image_room((size_t)needle->pool_capacity * sizeof(int));
    }
    return sum;
}

NDLI_API void ndli_remesh_snapshot(const ndl_remesh *r, void *buffer)
{
    ndli_image image;
    memset(&image, 0, sizeof image);
    image.out = (unsigned char *)buffer;
    ndli_remesh_write(r, 0, &image);
}

/* Takes an image that is good, once the body has the mesh that goes with it. */
static void ndli_remesh_read(ndl_remesh *r, const sb_body *body, const void *buffer)
{
    ndli_remesh_head head;
    ndli_image image;
    int counts[NDLI_TOPOLOGY_COUNTS];
    memset(&head, 0, sizeof head);
    memset(counts, 0, sizeof counts);
    memset(&image, 0, sizeof image);
    image.in = (const unsigned char *)buffer;
    ndli_image_part(&image, &head, 1, sizeof head);
    r->release_cursor = head.release_cursor;
    ndli_image_part(&image, counts, NDLI_TOPOLOGY_COUNTS, sizeof(int));
    ndli_topology_walk(r->mesh, counts, &image);
    ndli_topology_recall(r->mesh, counts, body);
    for (int i = 0; i < r->def.max_needles; i++) {
        int sizes[4];
        ndli_image_part(&image, sizes, 4, sizeof(int));
        ndli_remesh_walk_needle(r->needles + i, sizes, &image);
        r->needles[i].count = sizes[0];
        r->needles[i].depth = sizes[1];
        r->needles[i].pool_count = sizes[2];
    }
}

NDLI_API void ndli_remesh_rewind(ndl_remesh *r, const void *buffer)
{
    ndli_remesh_read(r, r->body, buffer);
    r->stale = 0;
}

/* Whether the image's splits name slots that there are, and pieces of the pool that there are. */
static int ndli_remesh_split_holds(const ndli_topology *mesh, const ndli_split *s, int pool_count)
{
    if (s->node < 0 || s->node >= mesh->node_end || s->size < 2 || s->size > 4 || s->first < 0 || s->count < 1 ||
        s->count > INT_MAX / 8 || s->first > pool_count - s->size * s->count)
        return 0;
    for (int i = 0; i < s->size; i++) {
        if (s->simplex[i] < 0 || s->simplex[i] >= mesh->node_end)
            return 0;
        for (int j = 0; j < i; j++)
            if (s->simplex[i] == s->simplex[j])
                return 0;
    }
    return 1;
}

static int ndli_remesh_slots_hold(const unsigned char *slots, int count, int end)
{
    for (int i = 0; i < count; i++) {
        int slot = ndli_image_int(slots, (size_t)i);
        if (slot < 0 || slot >= end)
            return 0;
    }
    return 1;
}

/* Checks a needle of the image that has `left` bytes left, and returns how many are the needle's; 0: damaged. counts:
 * out */
static size_t ndli_remesh_needle_holds(const ndli_topology *mesh, const unsigned char *in, size_t left, int counts[4])
{
    ndli_needle none;
    ndli_image image;
    size_t stack, pool;
    memset(&none, 0, sizeof none);
    memset(&image, 0, sizeof image);
    image.used = 4 * sizeof(int);
    if (left < image.used)
        return 0;
    memcpy(counts, in, 4 * sizeof(int));
    if (counts[0] < 0 || counts[1] < 0 || counts[2] < 0 || (size_t)counts[0] > left / sizeof(int) ||
        (size_t)counts[1] > left / sizeof(ndli_split) || (size_t)counts[2] > left / sizeof(int))
        return 0;
    stack = image.used + ((size_t)counts[0] * sizeof(int) + 7) / 8 * 8;
    pool = stack + (size_t)counts[1] * sizeof(ndli_split);
    ndli_remesh_walk_needle(&none, counts, &image);
    if (image.overflow || image.used > left ||
        !ndli_remesh_slots_hold(in + 4 * sizeof(int), counts[0], mesh->node_end) ||
        !ndli_remesh_slots_hold(in + pool, counts[2], mesh->tet_end))
        return 0;
    for (int i = 0; i < counts[1]; i++) {
        ndli_split split;
        memcpy(&split, in + stack + (size_t)i * sizeof split, sizeof split);
        if (!ndli_remesh_split_holds(mesh, &split, counts[2]))
            return 0;
    }
    return image.used;
}

/* ---- the rehearsal of an image ----
 * Undoing splits trusts the stacks: tets and nodes that it takes out must be those that the splits made. So all splits
 * of an image are undone on a copy of the topology first. */
typedef struct ndli_rehearsal {
    const ndli_topology *mesh;
    const unsigned char *owners, *flags; /* [node_end] of the image */
    int node_end;
    int *tets;               /* [tet_end][4]; first -1: not in use */
    int *stars;              /* [node_end] tets of a node; -1: undone */
    int *takers;             /* [tet_end] needle whose splits made the tet, or -1 */
    unsigned char *threaded; /* [node_end] 1: on a needle */
} ndli_rehearsal;

static void ndli_rehearsal_count(ndli_rehearsal *h, const int nodes[4], int step)
{
    for (int c = 0; c < 4; c++)
        h->stars[nodes[c]] += step;
}

/* Parts of one tet that was cut become that tet again; 0: they are not what a cut leaves. */
static int ndli_rehearsal_join(ndli_rehearsal *h, const ndli_split *s, const int *parts, int needle)
{
    int *first = h->tets + 4 * (size_t)parts[0], whole[4];
    for (int j = 0; j < s->size; j++) {
        if (h->takers[parts[j]] != -1 && h->takers[parts[j]] != needle)
            return 0;
        h->takers[parts[j]] = needle;
    }
    if (first[0] < 0 || !ndli_remesh_has(first, s->node) || ndli_remesh_has(first, s->simplex[0]))
        return 0;
    for (int c = 0; c < 4; c++)
        whole[c] = first[c] == s->node ? s->simplex[0] : first[c];
    if (!ndli_remesh_holds(whole, s->simplex, s->size))
        return 0;
    for (int j = 1; j < s->size; j++) {
        int *part = h->tets + 4 * (size_t)parts[j];
        for (int c = 0; c < 4; c++)
            if (part[c] != (whole[c] == s->simplex[j] ? s->node : whole[c]))
                return 0;
        ndli_rehearsal_count(h, part, -1);
        part[0] = -1;
    }
    ndli_rehearsal_count(h, first, -1);
    ndli_rehearsal_count(h, whole, 1);
    memcpy(first, whole, sizeof whole);
    return 1;
}

/* Undoes the stack of a needle, whose splits and pool the image holds from these places on. */
static int ndli_rehearsal_undo(ndli_rehearsal *h, const unsigned char *stack, int depth, const unsigned char *pool,
                               int pool_count, int needle)
{
    int end = pool_count;
    for (int i = depth - 1; i >= 0; i--) {
        ndli_split s;
        memcpy(&s, stack + (size_t)i * sizeof s, sizeof s);
        if (s.first + s.size * s.count != end || s.node >= h->node_end || !(h->flags[s.node] & NDLI_NODE_CREATED) ||
            h->stars[s.simplex[0]] < 1)
            return 0;
        end = s.first;
        for (int g = 0; g < s.count; g++) {
            int parts[4];
            memcpy(parts, pool + (size_t)(s.first + s.size * g) * sizeof(int), (size_t)s.size * sizeof(int));
            if (!ndli_rehearsal_join(h, &s, parts, needle))
                return 0;
        }
        if (h->stars[s.node] != 0)
            return 0;
        h->stars[s.node] = -1;
    }
    return end == 0;
}

/* Nodes of a needle, entry first: its own, each once, joined by edges. */
static int ndli_rehearsal_thread(ndli_rehearsal *h, const unsigned char *nodes, int count, int needle)
{
    const ndli_topology *mesh = h->mesh;
    for (int i = 0; i < count; i++) {
        int node = ndli_image_int(nodes, (size_t)i), joined = i == 0;
        if (node >= h->node_end || !(h->flags[node] & NDLI_NODE_NEEDLE) ||
            ndli_image_int(h->owners, (size_t)node) != needle || h->threaded[node])
            return 0;
        h->threaded[node] = 1;
        for (int k = joined ? -1 : mesh->node_star[node]; k >= 0 && !joined; k = mesh->corner_next[k])
            joined = ndli_remesh_has(mesh->tets + 4 * (size_t)(k / 4), ndli_image_int(nodes, (size_t)i - 1));
        if (!joined)
            return 0;
    }
    return 1;
}

static void ndli_rehearsal_free(const ndl_remesh *r, ndli_rehearsal *h)
{
    sbi_free(&r->def.allocator, h->tets);
    sbi_free(&r->def.allocator, h->stars);
    sbi_free(&r->def.allocator, h->takers);
    sbi_free(&r->def.allocator, h->threaded);
}

/* 0: no memory. */
static int ndli_rehearsal_begin(const ndl_remesh *r, ndli_rehearsal *h)
{
    size_t nodes = (size_t)r->mesh->node_end, tets = (size_t)r->mesh->tet_end;
    h->mesh = r->mesh;
    h->tets = (int *)sbi_alloc(&r->def.allocator, tets, 4 * sizeof(int));
    h->stars = (int *)sbi_alloc_zeroed(&r->def.allocator, nodes, sizeof(int));
    h->takers = (int *)sbi_alloc(&r->def.allocator, tets, sizeof(int));
    h->threaded = (unsigned char *)sbi_alloc_zeroed(&r->def.allocator, nodes, 1);
    if (!h->tets || !h->stars || !h->takers || !h->threaded)
        return 0;
    memcpy(h->tets, r->mesh->tets, tets * 4 * sizeof(int));
    for (size_t t = 0; t < tets; t++) {
        h->takers[t] = -1;
        if (h->tets[4 * t] >= 0)
            ndli_rehearsal_count(h, h->tets + 4 * t, 1);
    }
    return 1;
}

/* Every needle of an image whose indices are in their ranges. */
static sb_result ndli_rehearsal_play(const ndl_remesh *r, ndli_rehearsal *h, const unsigned char *in, sb_error *error)
{
    for (int i = 0; i < r->def.max_needles; i++) {
        const unsigned char *nodes = in + 4 * sizeof(int), *stack, *pool;
        int counts[4];
        memcpy(counts, in, sizeof counts);
        stack = nodes + ndli_image_room((size_t)counts[0] * sizeof(int));
        pool = stack + (size_t)counts[1] * sizeof(ndli_split);
        if (!ndli_rehearsal_thread(h, nodes, counts[0], i) ||
            !ndli_rehearsal_undo(h, stack, counts[1], pool, counts[2], i))
            return sbi_fail(error, SB_ERROR_FORMAT,
                            "the saved remesher is damaged: needle %d's nodes or splits are not "
                            "those of the body",
                            i);
        in = pool + ndli_image_room((size_t)counts[2] * sizeof(int));
    }
    for (int i = 0; i < h->node_end; i++)
        if (h->threaded[i] != !!(h->flags[i] & NDLI_NODE_NEEDLE) ||
            (h->stars[i] >= 0 && (h->flags[i] & NDLI_NODE_CREATED)))
            return sbi_fail_node(error, SB_ERROR_FORMAT, i,
                                 "the saved remesher is damaged: it knows nothing of the "
                                 "needle or the split of node %d",
                                 i);
    return SB_OK;
}

/* Where the needles of an image begin; 0: its counts are none. counts: out. */
static size_t ndli_remesh_needles_at(const ndl_remesh *r, const unsigned char *in, size_t size, int *counts)
{
    ndli_topology topology = *r->mesh;
    ndli_image image;
    size_t at = sizeof(ndli_remesh_head);
    if (size < at + NDLI_TOPOLOGY_COUNTS * sizeof(int))
        return 0;
    memcpy(counts, in + at, NDLI_TOPOLOGY_COUNTS * sizeof(int));
    if (counts[0] < 0 || counts[0] > topology.node_end || counts[1] < 0 || counts[1] > counts[0] || counts[2] < 0 ||
        counts[3] < 0 || counts[2] > topology.node_capacity || counts[3] > topology.tet_capacity)
        return 0;
    memset(&image, 0, sizeof image);
    image.used = at + NDLI_TOPOLOGY_COUNTS * sizeof(int);
    ndli_topology_walk(&topology, counts, &image);
    return image.overflow || image.used > size ? 0 : image.used;
}

static sb_result ndli_remesh_rehearse(const ndl_remesh *r, const unsigned char *in, size_t size, sb_error *error)
{
    ndli_rehearsal rehearsal;
    sb_result result;
    int counts[NDLI_TOPOLOGY_COUNTS];
    size_t needles = ndli_remesh_needles_at(r, in, size, counts);
    memset(&rehearsal, 0, sizeof rehearsal);
    rehearsal.owners =
        in + sizeof(ndli_remesh_head) + sizeof counts + ndli_image_room((size_t)counts[0] * sizeof(sb_vec3));
    rehearsal.flags = rehearsal.owners + ndli_image_room((size_t)counts[0] * sizeof(int));
    rehearsal.node_end = counts[0];
    result = ndli_rehearsal_begin(r, &rehearsal)
                 ? ndli_rehearsal_play(r, &rehearsal, in + needles, error)
                 : sbi_fail(error, SB_ERROR_MEMORY, "out of memory to check the splits of a saved remesher");
    ndli_rehearsal_free(r, &rehearsal);
    return result;
}

static sb_result ndli_remesh_check_head(const ndl_remesh *r, const ndli_remesh_head *head, sb_error *error)
{
    ndli_remesh_head own;
    ndli_remesh_fill_head(r, &own);
    if (head->order != NDLI_IMAGE_ORDER)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the saved remesher is of a machine with another order of bytes");
    if (head->smooth_below != own.smooth_below || head->release_above != own.release_above ||
        head->entry_slip != own.entry_slip || head->max_needles != own.max_needles ||
        head->interfaces != own.interfaces || head->max_smoothed != own.max_smoothed)
        return sbi_fail(error, SB_ERROR_STATE, "the saved remesher was made from another def");
    if (head->stale)
        return SB_OK;
    if (head->mesh != ndli_remesh_hash_mesh(r->mesh))
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher is damaged: it is not of the body's mesh");
    if (head->release_cursor < 0 || head->release_cursor >= r->mesh->original_nodes) /* only those are displaced */
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher is damaged: it goes on at displaced node %d",
                        head->release_cursor);
    return SB_OK;
}

/* Checks what follows an image's head; room = 1: makes room for the needles, which the checks have passed. */
static sb_result ndli_remesh_pass(ndl_remesh *r, const unsigned char *in, size_t size, int room, sb_error *error)
{
    int memory[NDLI_TOPOLOGY_COUNTS];
    sb_result result = SB_OK;
    size_t at = ndli_remesh_needles_at(r, in, size, memory);
    if (at == 0)
        result = sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher has counts out of their range");
    if (result == SB_OK && !room)
        result = ndli_topology_check_memory(r->mesh, memory, in + sizeof(ndli_remesh_head) + sizeof memory,
                                            r->def.max_needles, error);
    for (int i = 0; result == SB_OK && i < r->def.max_needles; i++) {
        int counts[4];
        size_t used = ndli_remesh_needle_holds(r->mesh, in + at, size - at, counts);
        at += used;
        if (!used)
            return sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher is damaged at needle %d", i);
        if (room && !ndli_remesh_make_room(r, r->needles + i, counts))
            return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for the stack of needle %d", i);
    }
    if (result == SB_OK && at != size)
        result = sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher has another size than its counts tell");
    return result;
}

/* ---- the part of the body's state ---- */

/* By its name it comes before that of the needles, which are checked against it. */
static const char ndli_remesh_name[] = "mesher";
enum { NDLI_REMESH_VERSION = 1 };

static void ndli_remesh_save_part(const void *user, sbi_state_out *out)
{
    const ndl_remesh *r = (const ndl_remesh *)user;
    ndli_image image;
    memset(&image, 0, sizeof image);
    image.state = out;
    ndli_remesh_write(r, r->stale ? 0 : ndli_remesh_hash_mesh(r->mesh), &image);
    out->overflow |= image.overflow;
}

static void ndli_remesh_give_up_part(void *user)
{
    ndl_remesh *r = (ndl_remesh *)user;
    ndli_remesh_free_knowledge(r->staged);
    if (r->staged)
        sbi_free(&r->def.allocator, r->staged);
    r->staged = NULL;
}

/* What needles had reserved, so that steps after a load take no more memory than before it. */
static int ndli_remesh_stage_room(const ndl_remesh *r)
{
    int good = 1;
    for (int i = 0; good && i < r->def.max_needles; i++) {
        const ndli_needle *needle = r->needles + i;
        int counts[3];
        counts[0] = needle->node_capacity / 3 * 2; /* it takes half as many again */
        counts[1] = needle->stack_capacity / 3 * 2;
        counts[2] = needle->pool_capacity / 3 * 2;
        good = ndli_remesh_make_room(r->staged, r->staged->needles + i, counts);
    }
    return good;
}

/* A remesher of the body that has nothing but its knowledge. */
static sb_result ndli_remesh_stage(ndl_remesh *r, const sb_body *body, sb_error *error)
{
    ndl_remesh *staged = (ndl_remesh *)sbi_alloc_zeroed(&r->def.allocator, 1, sizeof *staged);
    r->staged = staged;
    if (staged) {
        staged->def = r->def;
        staged->mesh = &staged->topology;
        staged->topology.allocator = r->def.allocator;
        staged->needles =
            (ndli_needle *)sbi_alloc_zeroed(&r->def.allocator, (size_t)r->def.max_needles, sizeof(ndli_needle));
        if (staged->needles && ndli_topology_read(staged->mesh, body) && ndli_remesh_stage_room(r))
            return SB_OK;
    }
    return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a saved remesher");
}

static sb_result ndli_remesh_check_part(void *user, const sb_body *body, const unsigned char *bytes, size_t size,
                                        sb_error *error)
{
    ndl_remesh *r = (ndl_remesh *)user;
    ndli_remesh_head head;
    sb_result result;
    if (size < sizeof head)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher ends in its head");
    memcpy(&head, bytes, sizeof head);
    result = ndli_remesh_stage(r, body, error);
    if (result == SB_OK)
        result = ndli_remesh_check_head(r->staged, &head, error);
    if (result == SB_OK && head.stale && (head.stale != 1 || size != sizeof head))
        result = sbi_fail(error, SB_ERROR_FORMAT, "the saved remesher is damaged in its head");
    if (result == SB_OK && !head.stale)
        result = ndli_remesh_pass(r->staged, bytes, size, 0, error);
    if (result == SB_OK && !head.stale)
        result = ndli_remesh_rehearse(r->staged, bytes, size, error);
    if (result == SB_OK && !head.stale)
        result = ndli_remesh_pass(r->staged, bytes, size, 1, error);
    if (result != SB_OK) {
        ndli_remesh_give_up_part(r);
        return result;
    }
    r->staged->stale = head.stale;
    if (!head.stale)
        ndli_remesh_read(r->staged, body, bytes);
    return SB_OK;
}

NDLI_API const int *ndli_remesh_staged_nodes(const ndl_remesh *remesh, int needle, int *count)
{
    *count = remesh->staged->stale ? 0 : remesh->staged->needles[needle].count;
    return remesh->staged->needles[needle].nodes;
}

static void ndli_remesh_load_part(void *user, const unsigned char *bytes, size_t size)
{
    ndl_remesh *r = (ndl_remesh *)user, *staged = r->staged, old = *r;
    (void)bytes;
    (void)size;
    r->topology = staged->topology;
    r->needles = staged->needles;
    r->leaving = staged->leaving;
    r->leaving_capacity = staged->leaving_capacity;
    r->release_cursor = staged->release_cursor;
    r->stale = staged->stale;
    staged->topology = old.topology;
    staged->needles = old.needles;
    staged->leaving = old.leaving;
    ndli_remesh_give_up_part(r);
    ndli_topology_look(r->mesh, r->body);
}

/* ---- recording ---- */

NDLI_API void ndli_remesh_hush(ndl_remesh *r)
{
    if (r)
        sbi_body_mute(r->body);
}

NDLI_API void ndli_remesh_tell(ndl_remesh *r, const int *ints, size_t int_count, const sb_real *reals,
                               size_t real_count)
{
    int good = ints != NULL;
    sbi_body_unmute(r->body);
    for (size_t i = 0; i < real_count; i++)
        good &= sb_is_finite(reals[i]);
    if (good)
        sbi_body_tell_part(r->body, ndli_remesh_name, ints, int_count, reals, real_count);
}

NDLI_API void ndli_remesh_tell_puncture(ndl_remesh *r, int needle, const ndl_surface_hit *hit, sb_real slip,
                                        sb_result result)
{
    int ints[5];
    sb_real reals[5];
    if (!r)
        return;
    if (!hit) {
        ndli_remesh_tell(r, NULL, 0, NULL, 0);
        return;
    }
    ints[0] = NDLI_COMMAND_PUNCTURE, ints[1] = needle, ints[2] = (int)result, ints[3] = hit->tet, ints[4] = hit->face;
    reals[0] = hit->along, reals[1] = hit->X.x, reals[2] = hit->X.y, reals[3] = hit->X.z, reals[4] = slip;
    ndli_remesh_tell(r, ints, 5, reals, 5);
}

NDLI_API void ndli_remesh_tell_move(ndl_remesh *r, int needle, sb_vec3 X, int forward, sb_result result)
{
    int ints[3];
    sb_real reals[3];
    if (!r)
        return;
    ints[0] = forward ? NDLI_COMMAND_PENETRATE : NDLI_COMMAND_RETRACT, ints[1] = needle, ints[2] = (int)result;
    reals[0] = X.x, reals[1] = X.y, reals[2] = X.z;
    ndli_remesh_tell(r, ints, 3, reals, 3);
}

NDLI_API void ndli_remesh_tell_withdraw(ndl_remesh *r, int needle, sb_result result)
{
    int ints[3];
    if (!r)
        return;
    ints[0] = NDLI_COMMAND_WITHDRAW, ints[1] = needle, ints[2] = (int)result;
    ndli_remesh_tell(r, ints, 3, NULL, 0);
}

/* A recording cannot make a remesher, nor end one: it says so when it is played. */
static void ndli_remesh_tell_life(ndl_remesh *r, ndli_remesh_command command)
{
    int ints[3];
    ints[0] = (int)command, ints[1] = 0, ints[2] = SB_OK;
    sbi_body_tell_part(r->body, ndli_remesh_name, ints, 3, NULL, 0);
}

NDLI_API sb_result ndli_remesh_join(ndl_remesh *r, ndli_remesh_replay replay, sb_error *error)
{
    sbi_state_part part;
    sb_result result;
    memset(&part, 0, sizeof part);
    memcpy(part.name, ndli_remesh_name, sizeof ndli_remesh_name);
    part.version = NDLI_REMESH_VERSION;
    part.user = r;
    part.save = ndli_remesh_save_part;
    part.check = ndli_remesh_check_part;
    part.load = ndli_remesh_load_part;
    part.give_up = ndli_remesh_give_up_part;
    part.replay = replay;
    result = sbi_body_join(r->body, &part, error);
    r->joined = result == SB_OK;
    if (result == SB_ERROR_ARGUMENT)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the body has a remesher already");
    if (r->joined)
        ndli_remesh_tell_life(r, NDLI_COMMAND_MADE);
    return result;
}

NDLI_API void ndli_remesh_leave(ndl_remesh *r)
{
    if (!r->joined)
        return;
    ndli_remesh_tell_life(r, NDLI_COMMAND_GONE);
    sbi_body_leave(r->body, ndli_remesh_name);
    r->joined = 0;
}

/* ==== src/needle/remesh.c ==== */
/* remesh: candidates, their comparison, the stack, smoothing, release.
 *
 * Candidates are tried on a copy of the tets about the tip, the patch, so that nothing needs to be taken back; only the
 * winner is done to the mesh. Two candidates are compared by the qualities they take away and bring: with D and C the
 * multisets a candidate removes and creates, the mesh after A is lexicographically better than after B exactly when
 * C_A + D_B is better than C_B + D_A, since all else is common to both. That is the thesis' comparison over T', the
 * union of what any candidate changes, without that union. */


#include <limits.h>
#include <string.h>

enum { NDLI_VIRTUAL = -1 /* the node to be made, in candidates */ };
enum { NDLI_IN_PATCH = 128 /* mark of tets while a patch is gathered */ };
enum {
    NDLI_USUAL_POOL = 32,  /* slots a split keeps: seldom more than eight tets of four pieces */
    NDLI_USUAL_PATCH = 512 /* tets: twice what graded meshes were seen to need */
};
enum { NDLI_SLIDE_SAMPLES = 10, NDLI_MAX_SUBSTEPS = 1000, NDLI_STUCK = 16, NDLI_RELEASES = 4, NDLI_RATED = 16 };
#define NDLI_REMESH_COOKIE 0x4e444c52u

/* ---- memory ---- */

static void ndli_remesh_layout(ndl_remesh *r, sbi_arena *arena, size_t n)
{
    size_t nodes = 4 * n + 1, tets = 3 * n + 8; /* a split makes at most twice the tets it cuts, or four of one */
    for (int i = 0; i < NDLI_FINALISTS; i++) {
        r->final[i].created.values = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
        r->final[i].removed.values = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
    }
    r->trial.created.values = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
    r->trial.removed.values = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
    r->taken.values = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
    r->table = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    r->table_whole = (unsigned char *)sbi_arena_take(arena, nodes, 1);
    r->draft.tets = (int *)sbi_arena_take(arena, tets, 4 * sizeof(int));
    r->draft.qualities = (sb_real *)sbi_arena_take(arena, tets, sizeof(sb_real));
    r->draft.X = (sb_vec3 *)sbi_arena_take(arena, nodes, sizeof(sb_vec3));
    r->draft.star_start = (int *)sbi_arena_take(arena, nodes + 2, sizeof(int));
    r->draft.star = (int *)sbi_arena_take(arena, tets, 4 * sizeof(int));
    r->draft.is_free = (unsigned char *)sbi_arena_take(arena, nodes, 1);
    r->draft.moved = (int *)sbi_arena_take(arena, nodes, sizeof(int));
    r->moves = (ndli_node_move *)sbi_arena_take(arena, nodes, sizeof(ndli_node_move));
    r->rating = (sb_real *)sbi_arena_take(arena, NDLI_RATED, sizeof(sb_real));
    r->best_rating = (sb_real *)sbi_arena_take(arena, NDLI_RATED, sizeof(sb_real));
    r->here.tets = (ndli_patch_tet *)sbi_arena_take(arena, n, sizeof(ndli_patch_tet));
    r->undone.tets = (ndli_patch_tet *)sbi_arena_take(arena, n, sizeof(ndli_patch_tet));
    r->moving = (int *)sbi_arena_take(arena, 2 * n + 8, 4 * sizeof(int));
    r->groups = (int *)sbi_arena_take(arena, 2 * n + 8, sizeof(int));
    r->kept = (int *)sbi_arena_take(arena, n + 8, 4 * sizeof(int));
    for (int i = 0; i < 2; i++)
        r->sorted[i] = (sb_real *)sbi_arena_take(arena, 6 * n + 16, sizeof(sb_real));
}

/* Room for patches of so many tets; keeps the one being gathered. */
static int ndli_remesh_scratch(ndl_remesh *r, int needed)
{
    ndl_remesh grown = *r;
    sbi_arena arena;
    size_t n = (size_t)needed + (size_t)needed / 2;
    if (needed <= r->capacity)
        return 1;
    memset(&arena, 0, sizeof arena);
    ndli_remesh_layout(&grown, &arena, n);
    arena.base = arena.overflow ? NULL : (unsigned char *)sbi_alloc(&r->def.allocator, arena.used, 1);
    if (!arena.base)
        return 0;
    arena.used = 0;
    ndli_remesh_layout(&grown, &arena, n);
    if (r->here.count)
        memcpy(grown.here.tets, r->here.tets, (size_t)r->here.count * sizeof(ndli_patch_tet));
    if (r->undone.count)
        memcpy(grown.undone.tets, r->undone.tets, (size_t)r->undone.count * sizeof(ndli_patch_tet));
    grown.scratch = arena.base;
    grown.capacity = (int)n;
    sbi_free(&r->def.allocator, r->scratch);
    *r = grown;
    return 1;
}

/* All that one operation may need, before anything changes. */
static int ndli_remesh_reserve(ndl_remesh *r)
{
    ndli_needle *needle = r->needles + r->needle;
    int tets = 2 * r->here.count + 8, counts[3];
    counts[0] = needle->count + 1;
    counts[1] = needle->depth + 1;
    counts[2] = needle->pool_count + tets;
    return ndli_remesh_make_room(r, needle, counts) && ndli_topology_reserve(r->mesh, 1, tets);
}

NDL_API ndl_remesh_def ndl_default_remesh_def(void)
{
    ndl_remesh_def def;
    memset(&def, 0, sizeof def);
    def.max_needles = 4;
    def.interfaces = NDL_INTERFACE_MOVE;
    def.smooth_below = (sb_real)0.55;
    def.release_above = (sb_real)0.6;
    def.max_smoothed = 16;
    def.entry_slip = NDLI_ENTRY_SLIP;
    def.cookie = NDLI_REMESH_COOKIE;
    return def;
}

static sb_result ndli_remesh_check_def(const ndl_remesh_def *def, sb_error *error)
{
    if (!def || def->cookie != NDLI_REMESH_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by ndl_default_remesh_def");
    if (!def->body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "body is NULL");
    if (def->max_needles < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_needles is %d", def->max_needles);
    if (def->interfaces != NDL_INTERFACE_KEEP_NODES && def->interfaces != NDL_INTERFACE_MOVE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "interfaces is %d", (int)def->interfaces);
    if (!(def->smooth_below >= 0) || !(def->smooth_below < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "smooth_below is not in [0, 1)");
    if (!(def->release_above >= 0) || !(def->release_above <= 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "release_above is not in [0, 1]");
    if (!(def->entry_slip >= 0) || !(def->entry_slip <= 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "entry_slip is not in [0, 1]");
    if (def->max_smoothed < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_smoothed is %d", def->max_smoothed);
    return SB_OK;
}

/* ---- the body's own changes ---- */

/* Others may change the mesh while no needle has. */
static sb_result ndli_remesh_hear(void *user, const sb_body *body, const sb_mesh_change *change, sb_error *error)
{
    const ndl_remesh *r = (const ndl_remesh *)user;
    (void)body;
    (void)change;
    if (r->own || r->stale || ndli_topology_is_original(r->mesh))
        return SB_OK;
    return sbi_fail(error, SB_ERROR_STATE, "needles have changed the mesh: draw them out before others change it");
}

static void ndli_remesh_follow(void *user, const sb_body *body, const sb_mesh_change *change)
{
    ndl_remesh *r = (ndl_remesh *)user;
    (void)body;
    (void)change;
    r->stale = r->stale || !r->own;
}

/* Reads the body's mesh again once it is another: needles that were in it are not in this one. */
static sb_result ndli_remesh_freshen(ndl_remesh *r, sb_error *error)
{
    if (!r->stale)
        return SB_OK;
    if (!ndli_topology_read(r->mesh, r->body))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory to read the mesh that the body now has");
    for (int i = 0; i < r->def.max_needles; i++)
        r->needles[i].count = r->needles[i].depth = r->needles[i].pool_count = 0;
    r->release_cursor = 0;
    r->stale = 0;
    return SB_OK;
}

NDLI_API sb_result ndli_remesh_look(ndl_remesh *remesh, sb_error *error)
{
    sb_result result = ndli_remesh_freshen(remesh, error);
    if (result == SB_OK)
        ndli_topology_look(remesh->mesh, remesh->body);
    return result;
}

NDLI_API void ndli_remesh_set_own(ndl_remesh *remesh, int own) { remesh->own = own; }
NDLI_API int ndli_remesh_is_stale(const ndl_remesh *remesh) { return remesh->stale; }
NDLI_API const ndli_topology *ndli_remesh_topology(const ndl_remesh *remesh) { return remesh->mesh; }

/* ---- the patch ---- */

/* Nodes of the needle counted from its tip; -1 when there are not so many. */
static int ndli_remesh_from_tip(const ndli_needle *needle, int i)
{
    return i < needle->count ? needle->nodes[needle->count - 1 - i] : -1;
}

static int ndli_remesh_is_foreign(const ndl_remesh *r, int node)
{
    return node >= 0 && r->mesh->owner[node] >= 0 && r->mesh->owner[node] != r->needle;
}

static int ndli_remesh_skin_bit(const ndl_remesh *r, int tet, int face)
{
    return r->mesh->neighbours[4 * (size_t)tet + (size_t)face] < 0 ? 1 << face : 0;
}

static void ndli_remesh_begin_gather(ndl_remesh *r)
{
    for (int i = 0; i < r->here.count; i++)
        r->mesh->tet_mark[r->here.tets[i].slot] = NDLI_IN_PATCH;
}

static void ndli_remesh_end_gather(ndl_remesh *r)
{
    for (int i = 0; i < r->here.count; i++)
        r->mesh->tet_mark[r->here.tets[i].slot] = 0;
}

/* Adds the tets of a node that are not there yet; 0: no memory. */
static int ndli_remesh_gather(ndl_remesh *r, int node)
{
    ndli_topology *mesh = r->mesh;
    for (int k = node < 0 ? -1 : mesh->node_star[node]; k >= 0; k = mesh->corner_next[k]) {
        ndli_patch_tet *to;
        int tet = k / 4;
        if (mesh->tet_mark[tet] & NDLI_IN_PATCH)
            continue;
        if (!ndli_remesh_scratch(r, r->here.count + 1))
            return 0;
        mesh->tet_mark[tet] |= NDLI_IN_PATCH;
        to = r->here.tets + r->here.count;
        memcpy(to->nodes, mesh->tets + 4 * (size_t)tet, sizeof to->nodes);
        to->slot = tet;
        to->skin = 0;
        to->quality = mesh->qualities[tet];
        for (int c = 0; c < 4; c++)
            to->skin |= ndli_remesh_skin_bit(r, tet, c);
        r->here.count++;
    }
    return 1;
}

/* Tet that was cut, from its parts: the part that has `node` in place of simplex[j] knows the face opposite that. */
static void ndli_remesh_parent(const ndl_remesh *r, const ndli_split *split, const int *parts, ndli_patch_tet *parent)
{
    const ndli_topology *mesh = r->mesh;
    const int *n = mesh->tets + 4 * (size_t)parts[0];
    parent->slot = -1;
    parent->skin = 0;
    for (int c = 0; c < 4; c++)
        parent->nodes[c] = n[c] == split->node ? split->simplex[0] : n[c];
    for (int c = 0; c < 4; c++) {
        int part = parts[0];
        for (int j = 0; j < split->size; j++)
            if (split->simplex[j] == parent->nodes[c])
                part = parts[j];
        parent->skin |= ndli_remesh_skin_bit(r, part, c);
    }
    parent->quality = ndli_tet_quality(mesh->X[parent->nodes[0]], mesh->X[parent->nodes[1]], mesh->X[parent->nodes[2]],
                                       mesh->X[parent->nodes[3]]);
}

static const ndli_split *ndli_remesh_top(const ndli_needle *needle)
{
    return needle->depth ? needle->stack + needle->depth - 1 : NULL;
}

static sb_real ndli_remesh_least_weight(const ndl_remesh *r, const int nodes[4], sb_vec3 X)
{
    const sb_vec3 *p = r->mesh->X;
    sb_real w[4];
    ndli_tet_weights(p[nodes[0]], p[nodes[1]], p[nodes[2]], p[nodes[3]], X, w);
    return sb_min(sb_min(w[0], w[1]), sb_min(w[2], w[3]));
}

/* Nodes of the tet that would hold X without the top split. */
static void ndli_remesh_undone_holder(const ndl_remesh *r, const ndli_split *top, sb_vec3 X, int holder[4])
{
    const ndli_needle *needle = r->needles + r->needle;
    ndli_patch_tet parent;
    sb_real most = -SB_REAL_MAX;
    if (!ndli_remesh_has(holder, top->node))
        return;
    for (int g = 0; g < top->count; g++) {
        sb_real least;
        ndli_remesh_parent(r, top, needle->pool + top->first + top->size * g, &parent);
        least = ndli_remesh_least_weight(r, parent.nodes, X);
        if (least > most) {
            most = least;
            memcpy(holder, parent.nodes, sizeof parent.nodes);
        }
    }
}

/* The patch as it would be without the top split, and the qualities that this removes. */
static void ndli_remesh_fill_undone(ndl_remesh *r, const ndli_split *top)
{
    const ndli_needle *needle = r->needles + r->needle;
    r->undone.count = r->taken.count = 0;
    for (int i = 0; i < r->here.count; i++)
        if (ndli_remesh_has(r->here.tets[i].nodes, top->node))
            r->taken.values[r->taken.count++] = r->here.tets[i].quality;
        else
            r->undone.tets[r->undone.count++] = r->here.tets[i];
    for (int g = 0; g < top->count; g++)
        ndli_remesh_parent(r, top, needle->pool + top->first + top->size * g, r->undone.tets + r->undone.count++);
}

/* ---- candidates: their qualities ---- */

static void ndli_remesh_push(ndli_qualities *list, sb_real quality)
{
    list->values[list->count++] = quality;
    list->least = sb_min(list->least, quality);
}

static sb_vec3 ndli_remesh_at(const ndl_remesh *r, int node)
{
    const ndli_candidate *t = &r->trial;
    if (node == NDLI_VIRTUAL || (t->size == 1 && node == t->simplex[0]))
        return t->X;
    return node == t->slid ? t->slid_X : r->mesh->X[node];
}

static sb_real ndli_remesh_quality(const ndl_remesh *r, const int n[4])
{
    return ndli_tet_quality(ndli_remesh_at(r, n[0]), ndli_remesh_at(r, n[1]), ndli_remesh_at(r, n[2]),
                            ndli_remesh_at(r, n[3]));
}

/* A tet that the candidate makes or changes. */
static void ndli_remesh_add(ndl_remesh *r, const int nodes[4])
{
    if (r->trial.slid >= 0 && ndli_remesh_has(nodes, r->trial.slid)) {
        memcpy(r->moving + 4 * (size_t)r->moving_count++, nodes, 4 * sizeof(int));
        return;
    }
    ndli_remesh_push(&r->trial.created, ndli_remesh_quality(r, nodes));
}

static void ndli_remesh_add_children(ndl_remesh *r, const int nodes[4])
{
    for (int j = 0; j < r->trial.size; j++) {
        int child[4];
        for (int c = 0; c < 4; c++)
            child[c] = nodes[c] == r->trial.simplex[j] ? (int)NDLI_VIRTUAL : nodes[c];
        ndli_remesh_add(r, child);
    }
}

/* 0 when a tet that the candidate would change is another needle's. */
static int ndli_remesh_collect(ndl_remesh *r, const ndli_patch *patch)
{
    ndli_candidate *t = &r->trial;
    t->created.count = t->removed.count = r->moving_count = 0;
    t->created.least = t->removed.least = SB_REAL_MAX;
    for (int i = 0; t->undo && i < r->taken.count; i++)
        ndli_remesh_push(&t->removed, r->taken.values[i]);
    for (int i = 0; i < patch->count; i++) {
        const ndli_patch_tet *tet = patch->tets + i;
        int hit = ndli_remesh_holds(tet->nodes, t->simplex, t->size);
        int slides = t->slid >= 0 && ndli_remesh_has(tet->nodes, t->slid);
        if (!hit && !slides) {
            if (tet->slot < 0)
                ndli_remesh_push(&t->created, tet->quality);
            continue;
        }
        for (int c = 0; c < 4; c++)
            if (ndli_remesh_is_foreign(r, tet->nodes[c])) {
                r->conflict = tet->nodes[c];
                return 0;
            }
        if (tet->slot >= 0)
            ndli_remesh_push(&t->removed, tet->quality);
        if (hit && t->size > 1)
            ndli_remesh_add_children(r, tet->nodes);
        else
            ndli_remesh_add(r, tet->nodes);
    }
    return 1;
}

/* Worst quality about the sliding node; anything <= floor when it is not better than floor. The tet that decided goes
 * to the front: it is likely to decide again. */
static sb_real ndli_remesh_moving_least(ndl_remesh *r, sb_real floor)
{
    sb_real least = SB_REAL_MAX;
    for (int i = 0; i < r->moving_count; i++) {
        int *tet = r->moving + 4 * (size_t)i, swap[4];
        least = sb_min(least, ndli_remesh_quality(r, tet));
        if (least > floor)
            continue;
        memcpy(swap, tet, sizeof swap);
        memcpy(tet, r->moving, sizeof swap);
        memcpy(r->moving, swap, sizeof swap);
        return least;
    }
    return least;
}

/* What the sliding node's worst tet must beat for the trial to be among the best. */
static sb_real ndli_remesh_floor(const ndl_remesh *r)
{
    if (r->final_count < NDLI_FINALISTS)
        return 0;
    return sb_max(0, sb_min(r->final[NDLI_FINALISTS - 1].created.least, r->trial.removed.least));
}

/* Puts the sliding node where its worst tet is best: its present place, samples on the segment, and two halvings about
 * the best of these. 0 when all are too bad. */
static int ndli_remesh_slide(ndl_remesh *r, sb_vec3 from, sb_vec3 to)
{
    ndli_candidate *t = &r->trial;
    sb_vec3 way = sb_v3_sub(to, from), present = r->mesh->X[t->slid];
    sb_real floor = ndli_remesh_floor(r), best, at = -1, step = (sb_real)1 / (NDLI_SLIDE_SAMPLES + 1);
    t->slid_X = present;
    best = sb_max(floor, ndli_remesh_moving_least(r, floor));
    for (int i = 1; i <= NDLI_SLIDE_SAMPLES; i++) {
        sb_real q;
        t->slid_X = sb_v3_madd(from, (sb_real)i * step, way);
        q = ndli_remesh_moving_least(r, best);
        if (q > best) {
            best = q;
            at = (sb_real)i * step;
        }
    }
    for (int round = 0; at >= 0 && round < 2; round++) {
        sb_real middle = at;
        step /= 2;
        for (int side = -1; side <= 1; side += 2) {
            sb_real q;
            t->slid_X = sb_v3_madd(from, middle + (sb_real)side * step, way);
            q = ndli_remesh_moving_least(r, best);
            if (q > best) {
                best = q;
                at = middle + (sb_real)side * step;
            }
        }
    }
    t->slid_moves = at >= 0;
    t->slid_X = at >= 0 ? sb_v3_madd(from, at, way) : present;
    return best > floor;
}

/* Where a ray from inside the sliding node's star leaves it. */
static sb_vec3 ndli_remesh_ray_end(const ndl_remesh *r, sb_vec3 from, sb_vec3 direction)
{
    sb_real end = 0;
    for (int i = 0; i < r->moving_count; i++) {
        sb_vec3 p[3], n, w;
        sb_real den, s;
        int k = 0;
        for (int c = 0; c < 4; c++)
            if (r->moving[4 * i + c] != r->trial.slid)
                p[k++] = ndli_remesh_at(r, r->moving[4 * i + c]);
        n = sb_v3_cross(sb_v3_sub(p[1], p[0]), sb_v3_sub(p[2], p[0]));
        den = sb_v3_dot(direction, n);
        s = sb_v3_dot(sb_v3_sub(p[0], from), n);
        if (!(s * den > 0)) /* behind, on the start, or parallel */
            continue;
        s /= den;
        w = sb_v3_madd(from, s, direction);
        if (sb_v3_dot(sb_v3_cross(sb_v3_sub(p[1], p[0]), sb_v3_sub(w, p[0])), n) >= 0 &&
            sb_v3_dot(sb_v3_cross(sb_v3_sub(p[2], p[1]), sb_v3_sub(w, p[1])), n) >= 0 &&
            sb_v3_dot(sb_v3_cross(sb_v3_sub(p[0], p[2]), sb_v3_sub(w, p[2])), n) >= 0)
            end = sb_max(end, s);
    }
    return sb_v3_madd(from, end, direction);
}

static void ndli_remesh_sort(sb_real *a, int count)
{
    for (int i = 1; i < count; i++) {
        sb_real value = a[i];
        int j = i;
        for (; j > 0 && a[j - 1] > value; j--)
            a[j] = a[j - 1];
        a[j] = value;
    }
}

static int ndli_remesh_merge(sb_real *to, const ndli_qualities *a, const ndli_qualities *b)
{
    memcpy(to, a->values, (size_t)a->count * sizeof(sb_real));
    memcpy(to + a->count, b->values, (size_t)b->count * sizeof(sb_real));
    ndli_remesh_sort(to, a->count + b->count);
    return a->count + b->count;
}

/* 1 when the trial leaves a better mesh than b. The minimum decides nearly always. */
static int ndli_remesh_is_better(ndl_remesh *r, const ndli_candidate *b)
{
    const ndli_candidate *t = &r->trial;
    sb_real mine = sb_min(t->created.least, b->removed.least), theirs = sb_min(b->created.least, t->removed.least);
    int n, m;
    if (mine > theirs || mine < theirs)
        return mine > theirs;
    n = ndli_remesh_merge(r->sorted[0], &t->created, &b->removed);
    m = ndli_remesh_merge(r->sorted[1], &b->created, &t->removed);
    for (int i = 0; i < n && i < m; i++)
        if (r->sorted[0][i] > r->sorted[1][i] || r->sorted[0][i] < r->sorted[1][i])
            return r->sorted[0][i] > r->sorted[1][i];
    return n < m; /* a missing entry counts as infinitely good */
}

/* 1 when what the trial brings, so far, is already worse than all that could speak for it. */
static int ndli_remesh_is_lost(const ndl_remesh *r)
{
    sb_real least = r->trial.created.least;
    return !(least > 0) || (r->final_count == NDLI_FINALISTS && least < r->final[NDLI_FINALISTS - 1].created.least &&
                            least < r->trial.removed.least);
}

/* ---- candidates: which ---- */

typedef enum ndli_move {
    NDLI_SNAP_TIP, /* (a) */
    NDLI_AHEAD,    /* (b) another node comes to lie at X_new, the old tip stays on the needle */
    NDLI_UNDO,     /* (c) the top split, which made the tip, is undone first */
    NDLI_DROP      /* (d) the tip stays in the tissue, but not on the needle */
} ndli_move;

/* Nodes between regions may be bound to their place; those that a split made there are not. */
static int ndli_remesh_is_bound(const ndl_remesh *r, int node)
{
    int flags = r->mesh->node_flags[node];
    return (flags & (NDLI_NODE_FIXED | NDLI_NODE_BOUNDARY)) ||
           ((flags & (NDLI_NODE_INTERFACE | NDLI_NODE_CREATED)) == NDLI_NODE_INTERFACE &&
            r->def.interfaces == NDL_INTERFACE_KEEP_NODES);
}

/* The needle's nodes after the tip that X_new will have next to it. */
static int ndli_remesh_anchor(const ndl_remesh *r, ndli_move move)
{
    return ndli_remesh_from_tip(r->needles + r->needle, move == NDLI_AHEAD ? 0 : 1);
}

static int ndli_remesh_may_snap(const ndl_remesh *r, int node, ndli_move move)
{
    if (ndli_remesh_is_bound(r, node))
        return 0;
    if (!(r->mesh->node_flags[node] & NDLI_NODE_NEEDLE))
        return 1;
    return move == NDLI_SNAP_TIP ? node == ndli_remesh_from_tip(r->needles + r->needle, 0)
                                 : move != NDLI_AHEAD && node == ndli_remesh_anchor(r, move);
}

static int ndli_remesh_is_shaft(const ndl_remesh *r, const int edge[2], ndli_move move)
{
    const ndli_needle *needle = r->needles + r->needle;
    int last = move == NDLI_AHEAD ? needle->count - 1 : needle->count - 2;
    for (int i = 0; i < last; i++)
        if ((needle->nodes[i] == edge[0] && needle->nodes[i + 1] == edge[1]) ||
            (needle->nodes[i] == edge[1] && needle->nodes[i + 1] == edge[0]))
            return 1;
    return 0;
}

/* Whether the trial keeps the surface, the walls and the needle's path. */
static int ndli_remesh_is_legal(const ndl_remesh *r, const ndli_patch *patch, ndli_move move)
{
    const ndli_candidate *t = &r->trial;
    int anchor = ndli_remesh_anchor(r, move), joined = move == NDLI_SNAP_TIP;
    if (t->size == 1 && !ndli_remesh_may_snap(r, t->simplex[0], move))
        return 0;
    if (t->size == 2 && ndli_remesh_is_shaft(r, t->simplex, move))
        return 0;
    for (int i = 0; i < patch->count; i++) {
        const ndli_patch_tet *tet = patch->tets + i;
        if (!ndli_remesh_holds(tet->nodes, t->simplex, t->size))
            continue;
        joined |= ndli_remesh_has(tet->nodes, anchor);
        for (int c = 0; t->size > 1 && c < 4; c++) {
            int part = 0; /* of the simplex: the corner that the face lies opposite to */
            for (int j = 0; j < t->size; j++)
                part |= tet->nodes[c] == t->simplex[j];
            if (!part && (tet->skin >> c & 1))
                return 0;
        }
    }
    return joined;
}

/* Puts the trial into its place among the best. */
static void ndli_remesh_rank(ndl_remesh *r)
{
    int last = NDLI_FINALISTS - 1, place = r->final_count;
    while (place > 0 && ndli_remesh_is_better(r, r->final + place - 1))
        place--;
    if (place > last)
        return;
    r->final_count = sbi_min_int(r->final_count + 1, NDLI_FINALISTS);
    {
        ndli_candidate spare = r->final[r->final_count - 1];
        for (int i = r->final_count - 1; i > place; i--)
            r->final[i] = r->final[i - 1];
        r->final[place] = r->trial;
        r->trial = spare;
    }
}

/* Which node slides, and between where. Returns 0 when none does. */
static int ndli_remesh_slider(const ndl_remesh *r, ndli_move move, sb_vec3 *to)
{
    const ndli_needle *needle = r->needles + r->needle;
    int anchor = ndli_remesh_anchor(r, move), next, node;
    if (move == NDLI_SNAP_TIP)
        return -1;
    if (move == NDLI_DROP) {
        node = ndli_remesh_from_tip(needle, 0);
        *to = r->mesh->X[anchor];
        if (r->trial.size == 1 && r->trial.simplex[0] == node)
            return -1;
    } else {
        int snaps_anchor = r->trial.size == 1 && r->trial.simplex[0] == anchor, first = move == NDLI_AHEAD ? 0 : 1;
        node = ndli_remesh_from_tip(needle, first + snaps_anchor);
        next = ndli_remesh_from_tip(needle, first + snaps_anchor + 1);
        if (node < 0 || next < 0)
            return -1;
        *to = r->mesh->X[next];
    }
    return ndli_remesh_is_bound(r, node) ? -1 : node;
}

/* Rates the trial, whose simplex, X and undo are set, and keeps it when it is the best so far. */
static void ndli_remesh_try(ndl_remesh *r, const ndli_patch *patch, ndli_move move)
{
    ndli_candidate *t = &r->trial;
    sb_vec3 to = t->X;
    t->slid = -1;
    t->slid_moves = 0;
    if (!ndli_remesh_is_legal(r, patch, move))
        return;
    t->slid = ndli_remesh_slider(r, move, &to);
    r->info.candidates++;
    if (!ndli_remesh_collect(r, patch) || ndli_remesh_is_lost(r))
        return;
    if (t->slid >= 0) {
        if (move == NDLI_DROP)
            to = ndli_remesh_ray_end(r, t->X, sb_v3_sub(t->X, to));
        if (!ndli_remesh_slide(r, t->X, to))
            return;
        for (int i = 0; i < r->moving_count; i++)
            ndli_remesh_push(&t->created, ndli_remesh_quality(r, r->moving + 4 * (size_t)i));
    }
    t->drops_tip = move == NDLI_DROP;
    if (!ndli_remesh_is_lost(r))
        ndli_remesh_rank(r);
}

/* All standard operations in the tet that holds X_new on up to `most` of its nodes: 15 for 4, the snaps for 1. */
static void ndli_remesh_try_standard(ndl_remesh *r, const ndli_patch *patch, const int holder[4], int most, sb_vec3 X,
                                     ndli_move move)
{
    for (int set = 1; set < 16; set++) {
        ndli_candidate *t = &r->trial;
        if ((set & 1) + (set >> 1 & 1) + (set >> 2 & 1) + (set >> 3) > most)
            continue;
        t->size = 0;
        t->X = X;
        t->undo = move == NDLI_UNDO;
        for (int c = 0; c < 4; c++)
            if (set >> c & 1)
                t->simplex[t->size++] = holder[c];
        ndli_remesh_try(r, patch, move);
    }
}

static void ndli_remesh_try_snap_tip(ndl_remesh *r, int tip, sb_vec3 X)
{
    ndli_candidate *t = &r->trial;
    t->size = 1;
    t->simplex[0] = tip;
    t->X = X;
    t->undo = 0;
    ndli_remesh_try(r, &r->here, NDLI_SNAP_TIP);
}

/* ---- smoothing ----
 * Which candidate is best shows only when the nodes about it have made way, so the best few are compared with that
 * done, on drafts. */

static int ndli_remesh_local(const ndl_remesh *r, int node)
{
    return node == NDLI_VIRTUAL ? r->table_count : r->mesh->node_index[node] - 1;
}

static void ndli_remesh_clear_table(ndl_remesh *r)
{
    for (int i = 0; i < r->table_count; i++)
        r->mesh->node_index[r->table[i]] = 0;
    r->table_count = 0;
}

static void ndli_remesh_enter(ndl_remesh *r, int node)
{
    if (r->mesh->node_index[node])
        return;
    r->table_whole[r->table_count] = 0;
    r->table[r->table_count++] = node;
    r->mesh->node_index[node] = r->table_count;
}

static void ndli_remesh_draft_tet(ndl_remesh *r, const int nodes[4])
{
    int *to = r->draft.tets + 4 * (size_t)r->draft.tet_count++;
    for (int c = 0; c < 4; c++)
        to[c] = ndli_remesh_local(r, nodes[c]);
}

static void ndli_remesh_draft_tets(ndl_remesh *r, const ndli_candidate *c)
{
    const ndli_patch *patch = c->undo ? &r->undone : &r->here;
    int count = c->undo ? r->undone.count : r->core_count;
    r->draft.tet_count = 0;
    for (int i = 0; i < count; i++) {
        const int *nodes = patch->tets[i].nodes;
        int cut = c->size > 1 && ndli_remesh_holds(nodes, c->simplex, c->size);
        for (int j = 0; cut && j < c->size; j++) {
            int child[4];
            for (int k = 0; k < 4; k++)
                child[k] = nodes[k] == c->simplex[j] ? (int)NDLI_VIRTUAL : nodes[k];
            ndli_remesh_draft_tet(r, child);
        }
        if (!cut)
            ndli_remesh_draft_tet(r, nodes);
    }
    r->draft.core_count = r->draft.tet_count;
    for (int i = r->core_count; i < r->here.count; i++)
        ndli_remesh_draft_tet(r, r->here.tets[i].nodes);
}

static sb_real ndli_remesh_draft_quality(const ndli_draft *d, int tet)
{
    const int *n = d->tets + 4 * (size_t)tet;
    return ndli_tet_quality(d->X[n[0]], d->X[n[1]], d->X[n[2]], d->X[n[3]]);
}

static void ndli_remesh_draft_stars(ndl_remesh *r)
{
    ndli_draft *d = &r->draft;
    int nodes = r->table_count + 1;
    memset(d->star_start, 0, ((size_t)nodes + 2) * sizeof(int));
    for (int i = 0; i < 4 * d->tet_count; i++)
        d->star_start[d->tets[i] + 2]++;
    for (int i = 0; i < nodes; i++)
        d->star_start[i + 2] += d->star_start[i + 1];
    for (int i = 0; i < 4 * d->tet_count; i++)
        d->star[d->star_start[d->tets[i] + 1]++] = i;
}

/* Nodes that may make way: inner ones, not on the needle, with all their tets in the draft, none of them another
 * needle's. */
static void ndli_remesh_draft_free(ndl_remesh *r, const ndli_candidate *c)
{
    int tip = ndli_remesh_from_tip(r->needles + r->needle, 0);
    for (int i = 0; i < r->table_count; i++) {
        int node = r->table[i], flags = r->mesh->node_flags[node];
        int fixed = (flags & (NDLI_NODE_BOUNDARY | NDLI_NODE_FIXED)) ||
                    ((flags & NDLI_NODE_INTERFACE) && r->def.interfaces == NDL_INTERFACE_KEEP_NODES);
        if (c->drops_tip && node == tip)
            flags &= ~NDLI_NODE_NEEDLE;
        if ((c->size == 1 && node == c->simplex[0]) || (c->undo && node == tip) || (flags & NDLI_NODE_NEEDLE))
            fixed = 1;
        r->draft.is_free[i] = (unsigned char)(!fixed && r->table_whole[i]);
    }
    for (int t = 0; t < r->draft.tet_count; t++) {
        const int *n = r->draft.tets + 4 * (size_t)t;
        int foreign = 0;
        for (int k = 0; k < 4; k++)
            foreign |= n[k] < r->table_count && ndli_remesh_is_foreign(r, r->table[n[k]]);
        for (int k = 0; foreign && k < 4; k++)
            r->draft.is_free[n[k]] = 0;
    }
    r->draft.is_free[r->table_count] = 0;
}

static void ndli_remesh_make_draft(ndl_remesh *r, const ndli_candidate *c)
{
    ndli_draft *d = &r->draft;
    ndli_remesh_draft_tets(r, c);
    for (int i = 0; i < r->table_count; i++)
        d->X[i] = r->mesh->X[r->table[i]];
    d->X[r->table_count] = c->X;
    if (c->size == 1)
        d->X[ndli_remesh_local(r, c->simplex[0])] = c->X;
    if (c->slid_moves)
        d->X[ndli_remesh_local(r, c->slid)] = c->slid_X;
    d->moved_count = 0;
    ndli_remesh_draft_stars(r);
    ndli_remesh_draft_free(r, c);
    for (int t = 0; t < d->tet_count; t++)
        d->qualities[t] = ndli_remesh_draft_quality(d, t);
}

/* d quality / d X of the corner c of a tet. */
static sb_vec3 ndli_remesh_gradient(const ndli_draft *d, int tet, int c)
{
    static const int facing[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};
    const int *n = d->tets + 4 * (size_t)tet;
    sb_vec3 X = d->X[n[c]], p[3], e[3], sum, up;
    sb_real mean = 0, det;
    for (int i = 0; i < 3; i++) {
        p[i] = d->X[n[facing[c][i]]];
        e[i] = sb_v3_sub(X, p[i]);
        mean += sb_v3_dot(e[i], e[i]);
    }
    for (int i = 0; i < 3; i++) {
        sb_vec3 side = sb_v3_sub(p[i], p[(i + 1) % 3]);
        mean += sb_v3_dot(side, side);
    }
    mean /= 6;
    up = sb_v3_cross(sb_v3_sub(p[2], p[0]), sb_v3_sub(p[1], p[0]));
    det = sb_v3_dot(up, e[0]);
    sum = sb_v3_add(e[0], sb_v3_add(e[1], e[2]));
    return sb_v3_scale((sb_real)1.4142135623730951 / (mean * sb_sqrt(mean)), sb_v3_madd(up, -det / (2 * mean), sum));
}

static sb_real ndli_remesh_draft_least(const ndli_draft *d, int node)
{
    sb_real least = SB_REAL_MAX;
    for (int k = d->star_start[node]; k < d->star_start[node + 1]; k++)
        least = sb_min(least, d->qualities[d->star[k] / 4]);
    return least;
}

/* Direction in which all tets near the worst quality get better: the shortest vector in the hull of their gradients
 * (Freitag, Jones, Plassmann), by Gilbert's iteration. */
static sb_vec3 ndli_remesh_ascent(const ndli_draft *d, int node, sb_real least)
{
    sb_vec3 gradients[32], shortest;
    sb_real active = least + (sb_real)0.05;
    int count = 0;
    for (int k = d->star_start[node]; k < d->star_start[node + 1] && count < 32; k++)
        if (d->qualities[d->star[k] / 4] <= active)
            gradients[count++] = ndli_remesh_gradient(d, d->star[k] / 4, d->star[k] % 4);
    shortest = count ? gradients[0] : sb_v3(0, 0, 0);
    for (int i = 0; i < 12 && count > 1; i++) {
        sb_real low = SB_REAL_MAX, share;
        sb_vec3 way;
        int worst = 0;
        for (int j = 0; j < count; j++) {
            sb_real along = sb_v3_dot(shortest, gradients[j]);
            if (along < low) {
                low = along;
                worst = j;
            }
        }
        way = sb_v3_sub(shortest, gradients[worst]);
        share = sb_v3_dot(shortest, way);
        if (!(share > (sb_real)1e-3 * sb_v3_dot(shortest, shortest)))
            break;
        shortest = sb_v3_madd(shortest, -sb_min(1, share / sb_v3_dot(way, way)), way);
    }
    return shortest;
}

/* Worst quality about a node if it were at X; anything <= floor when that is not better than floor. */
static sb_real ndli_remesh_draft_at(ndli_draft *d, int node, sb_vec3 X, sb_real floor)
{
    sb_vec3 present = d->X[node];
    sb_real least = SB_REAL_MAX;
    d->X[node] = X;
    for (int k = d->star_start[node]; k < d->star_start[node + 1] && least > floor; k++)
        least = sb_min(least, ndli_remesh_draft_quality(d, d->star[k] / 4));
    d->X[node] = present;
    return least;
}

/* A better place for a free node; returns the worst quality about it there, or `now` when there is none. */
static sb_real ndli_remesh_improve(ndli_draft *d, int node, sb_real now, sb_vec3 *X)
{
    sb_vec3 way = ndli_remesh_ascent(d, node, now);
    sb_real best = now, size = 0, length = sb_v3_norm(way);
    const int *n = d->tets + 4 * (size_t)(d->star[d->star_start[node]] / 4);
    for (int c = 0; c < 4; c++)
        size = sb_max(size, sb_v3_norm(sb_v3_sub(d->X[n[c]], d->X[node])));
    if (!(length > 0))
        return now;
    for (sb_real step = (sb_real)0.32; step > (sb_real)0.015; step /= 2) {
        sb_vec3 at = sb_v3_madd(d->X[node], step * size / length, way);
        sb_real q = ndli_remesh_draft_at(d, node, at, best);
        if (q > best) {
            best = q;
            *X = at;
        } else if (best > now) {
            break;
        }
    }
    return best;
}

/* Worst tet of the draft's core that is worth work and not among those given up; or -1. */
static int ndli_remesh_worst_near(const ndl_remesh *r, const int *stuck, int stuck_count)
{
    const ndli_draft *d = &r->draft;
    sb_real least = r->def.smooth_below;
    int worst = -1;
    for (int tet = 0; tet < d->core_count; tet++) {
        const int *n = d->tets + 4 * (size_t)tet;
        int known = 0;
        if (!(d->qualities[tet] < least))
            continue;
        for (int j = 0; j < stuck_count; j++)
            known |= stuck[j] == tet;
        if (!known && (d->is_free[n[0]] || d->is_free[n[1]] || d->is_free[n[2]] || d->is_free[n[3]])) {
            least = d->qualities[tet];
            worst = tet;
        }
    }
    return worst;
}

static void ndli_remesh_move_in_draft(ndli_draft *d, int node, sb_vec3 X)
{
    int known = 0;
    d->X[node] = X;
    for (int k = d->star_start[node]; k < d->star_start[node + 1]; k++)
        d->qualities[d->star[k] / 4] = ndli_remesh_draft_quality(d, d->star[k] / 4);
    for (int i = 0; i < d->moved_count; i++)
        known |= d->moved[i] == node;
    if (!known)
        d->moved[d->moved_count++] = node;
}

static void ndli_remesh_smooth(ndl_remesh *r)
{
    const sb_real gain = (sb_real)0.005; /* less is not worth the diffusion that interpolating the state brings */
    ndli_draft *d = &r->draft;
    int stuck[NDLI_STUCK], stuck_count = 0;
    for (int moved = 0; moved < r->def.max_smoothed && stuck_count < NDLI_STUCK;) {
        int tet = ndli_remesh_worst_near(r, stuck, stuck_count), node = -1;
        sb_vec3 X = sb_v3(0, 0, 0), at = X;
        sb_real best = 0;
        if (tet < 0)
            return;
        for (int c = 0; c < 4; c++) {
            int candidate = d->tets[4 * (size_t)tet + (size_t)c];
            sb_real now, q;
            if (!d->is_free[candidate])
                continue;
            now = ndli_remesh_draft_least(d, candidate);
            q = ndli_remesh_improve(d, candidate, now, &at);
            if (q > now + gain && q > best) {
                best = q;
                node = candidate;
                X = at;
            }
        }
        if (node < 0) {
            stuck[stuck_count++] = tet;
            continue;
        }
        ndli_remesh_move_in_draft(d, node, X);
        moved++;
    }
}

/* The draft's lowest qualities, ascending. */
static void ndli_remesh_rate(ndl_remesh *r)
{
    sb_real *low = r->rating;
    for (int i = 0; i < NDLI_RATED; i++)
        low[i] = SB_REAL_MAX;
    for (int t = 0; t < r->draft.tet_count; t++) {
        int at = NDLI_RATED - 1;
        if (!(r->draft.qualities[t] < low[at]))
            continue;
        for (; at > 0 && low[at - 1] > r->draft.qualities[t]; at--)
            low[at] = low[at - 1];
        low[at] = r->draft.qualities[t];
    }
}

static int ndli_remesh_rates_better(const ndl_remesh *r)
{
    for (int i = 0; i < NDLI_RATED; i++)
        if (r->rating[i] > r->best_rating[i] || r->rating[i] < r->best_rating[i])
            return r->rating[i] > r->best_rating[i];
    return 0;
}

/* 1 when the nodes of the tet may have to make way: it touches the end of the needle or a whole edge of a holder. */
static int ndli_remesh_is_near(const ndl_remesh *r, const int nodes[4], const int holders[2][4])
{
    for (int i = 0; i < 3; i++) {
        int node = ndli_remesh_from_tip(r->needles + r->needle, i);
        if (node >= 0 && ndli_remesh_has(nodes, node))
            return 1;
    }
    for (int h = 0; h < 2; h++) {
        int common = 0;
        for (int c = 0; c < 4; c++)
            common += ndli_remesh_has(nodes, holders[h][c]);
        if (common > 1)
            return 1;
    }
    return 0;
}

/* Adds to the patch the tets of all nodes that may make way, and numbers its nodes; 0: no memory. */
static int ndli_remesh_widen(ndl_remesh *r, const int holders[2][4])
{
    int good = 1;
    ndli_remesh_begin_gather(r);
    for (int i = 0; i < r->core_count; i++) {
        ndli_patch_tet tet = r->here.tets[i];
        for (int c = 0; c < 4 && good && ndli_remesh_is_near(r, tet.nodes, holders); c++)
            good = ndli_remesh_gather(r, tet.nodes[c]);
    }
    ndli_remesh_end_gather(r);
    if (!good)
        return 0;
    r->table_count = 0;
    for (int i = 0; i < r->here.count; i++)
        for (int c = 0; c < 4; c++)
            ndli_remesh_enter(r, r->here.tets[i].nodes[c]);
    for (int i = 0; i < r->core_count; i++)
        for (int c = 0; c < 4 && ndli_remesh_is_near(r, r->here.tets[i].nodes, holders); c++)
            r->table_whole[ndli_remesh_local(r, r->here.tets[i].nodes[c])] = 1;
    return 1;
}

/* Keeps what was smoothed in the draft. */
static void ndli_remesh_keep_moves(ndl_remesh *r, const ndli_candidate *c)
{
    r->move_count = 0;
    for (int i = 0; i < r->draft.moved_count; i++)
        if (r->table[r->draft.moved[i]] != (c->slid_moves ? c->slid : -1)) {
            r->moves[r->move_count].node = r->table[r->draft.moved[i]];
            r->moves[r->move_count++].X = r->draft.X[r->draft.moved[i]];
        }
}

static sb_real ndli_remesh_core_least(const ndl_remesh *r)
{
    sb_real least = SB_REAL_MAX;
    for (int t = 0; t < r->draft.core_count; t++)
        least = sb_min(least, r->draft.qualities[t]);
    return least;
}

/* Smooths the finalists' drafts, until one leaves no tet of the core worse than `enough`, and puts the best
 * of them first; 0: no memory. */
static int ndli_remesh_decide(ndl_remesh *r, const int holders[2][4], sb_real enough)
{
    int winner = 0, done = 0;
    if (!ndli_remesh_widen(r, holders))
        return 0;
    for (int i = 0; i < r->final_count && !done; i++) {
        ndli_candidate *c = r->final + i;
        ndli_remesh_make_draft(r, c);
        ndli_remesh_smooth(r);
        ndli_remesh_rate(r);
        done = ndli_remesh_core_least(r) >= enough;
        if (i > 0 && !ndli_remesh_rates_better(r))
            continue;
        winner = i;
        memcpy(r->best_rating, r->rating, NDLI_RATED * sizeof(sb_real));
        r->outcome = ndli_remesh_core_least(r);
        for (int k = 0; k < r->draft.moved_count; k++) /* a freed tip may slide first and be smoothed then */
            if (c->slid_moves && r->table[r->draft.moved[k]] == c->slid)
                c->slid_X = r->draft.X[r->draft.moved[k]];
        ndli_remesh_keep_moves(r, c);
    }
    ndli_remesh_clear_table(r);
    if (winner) {
        ndli_candidate swap = r->final[0];
        r->final[0] = r->final[winner];
        r->final[winner] = swap;
    }
    return 1;
}

/* ---- doing it ---- */

static void ndli_remesh_pop(ndl_remesh *r, int index)
{
    ndli_needle *needle = r->needles + index;
    const ndli_split *top = needle->stack + needle->depth - 1;
    ndli_leaving *leaving = r->leaving + r->leaving_count++;
    leaving->node = top->node;
    leaving->size = top->size;
    memcpy(leaving->simplex, top->simplex, sizeof leaving->simplex);
    ndli_topology_mend(r->mesh, top->node, top->simplex, top->size, needle->pool + top->first, top->count);
    needle->pool_count = top->first;
    needle->depth--;
}

static void ndli_remesh_push_split(ndl_remesh *r, const ndli_candidate *c, int node, int count)
{
    ndli_needle *needle = r->needles + r->needle;
    ndli_split *split = needle->stack + needle->depth++;
    split->node = node;
    split->size = c->size;
    memcpy(split->simplex, c->simplex, sizeof split->simplex);
    split->first = needle->pool_count;
    split->count = count;
    memcpy(needle->pool + needle->pool_count, r->groups, (size_t)(count * c->size) * sizeof(int));
    needle->pool_count += count * c->size;
    r->mesh->owner[node] = r->needle;
}

/* ---- the body follows ---- */

enum { NDLI_MAX_HEIRS = 32 };

typedef struct ndli_heirs {
    int nodes[NDLI_MAX_HEIRS], count;
    sb_real weights[NDLI_MAX_HEIRS];
} ndli_heirs;

static const ndli_leaving *ndli_remesh_leaving(const ndl_remesh *r, int node)
{
    for (int i = 0; i < r->leaving_count; i++)
        if (r->leaving[i].node == node)
            return r->leaving + i;
    return NULL;
}

static void ndli_remesh_add_heir(ndli_heirs *heirs, int node, sb_real weight)
{
    for (int k = 0; k < heirs->count; k++)
        if (heirs->nodes[k] == node) {
            heirs->weights[k] += weight;
            return;
        }
    heirs->nodes[heirs->count] = node;
    heirs->weights[heirs->count++] = weight;
}

/* What refers to a node that goes refers to the corners of the split that made it from then on; those of corners that
 * go, too, stand for them. (Only the first of them once the list is full: a chain of that many splits.) */
static void ndli_remesh_find_heirs(const ndl_remesh *r, int node, ndli_heirs *heirs)
{
    const ndli_leaving *l = ndli_remesh_leaving(r, node);
    heirs->count = 0;
    for (int k = 0; l && k < l->size; k++)
        ndli_remesh_add_heir(heirs, l->simplex[k], (sb_real)1 / (sb_real)l->size);
    for (int i = 0; i < heirs->count;) {
        sb_real weight = heirs->weights[i];
        int parts;
        l = ndli_remesh_leaving(r, heirs->nodes[i]);
        if (!l) {
            i++;
            continue;
        }
        heirs->count--;
        heirs->nodes[i] = heirs->nodes[heirs->count];
        heirs->weights[i] = heirs->weights[heirs->count];
        parts = heirs->count + l->size <= NDLI_MAX_HEIRS ? l->size : 1;
        for (int k = 0; k < parts; k++)
            ndli_remesh_add_heir(heirs, l->simplex[k], weight / (sb_real)parts);
        i = 0;
    }
}

/* Moved nodes first: where their motion comes from is named by the slots of before. Nodes made are free, also between
 * held ones: tissue gives way to a needle, and they must be able to move with its tip, or their tets get flat. Rigid
 * about a stiff wire they made thousands of newtons. */
static sb_result ndli_remesh_send_nodes(ndl_remesh *r, const ndli_topology_change *c, sb_body_change *to,
                                        sb_error *error)
{
    sb_result result = SB_OK;
    int plan = 0;
    for (int i = 0; i < c->node_count && result == SB_OK; i++)
        if (!c->nodes[i].created)
            result = sb_body_change_move_node(to, c->nodes[i].node, c->nodes[i].X, c->nodes[i].sources,
                                              c->nodes[i].weights, 4, error);
    for (int i = 0; i < c->node_event_count && result == SB_OK; i++) {
        int event = c->node_events[i].node, slot = 0;
        ndli_heirs heirs;
        if (event < 0) {
            ndli_remesh_find_heirs(r, ~event, &heirs);
            result = sb_body_change_remove_node(to, ~event, heirs.nodes, heirs.weights, heirs.count, error);
            continue;
        }
        while (!c->nodes[plan].created)
            plan++;
        result = sb_body_change_add_node(to, c->nodes[plan].X, c->nodes[plan].sources, c->nodes[plan].weights, 4,
                                         SB_NODE_COPY, &slot, error);
        SB_ASSERT(result != SB_OK || slot == event);
        plan++;
    }
    return result;
}

static sb_change_cell ndli_remesh_cell(const ndl_remesh *r, int tet, int parent)
{
    sb_change_cell cell = sb_default_change_cell();
    cell.nodes = r->mesh->tets + 4 * (size_t)tet;
    cell.parent = parent;
    return cell;
}

/* 1: a node of the tet has come, maybe in the slot of one that has gone. */
static int ndli_remesh_is_renewed(const ndli_topology_change *c, const int nodes[4])
{
    for (int i = 0; i < c->node_event_count; i++)
        if (c->node_events[i].node >= 0 && ndli_remesh_has(nodes, c->node_events[i].node))
            return 1;
    return 0;
}

static sb_result ndli_remesh_send_tets(ndl_remesh *r, const ndli_topology_change *c, sb_body_change *to,
                                       sb_error *error)
{
    sb_result result = SB_OK;
    for (int i = 0; i < c->tet_event_count && result == SB_OK; i++) {
        int event = c->tet_events[i], slot = 0;
        if (event < 0) {
            result = sb_body_change_remove_cell(to, ~event, error);
        } else {
            sb_change_cell cell = ndli_remesh_cell(r, event, r->mesh->parents[event]);
            result = sb_body_change_add_cell(to, &cell, &slot, error);
            SB_ASSERT(result != SB_OK || slot == event);
        }
    }
    for (int i = 0; i < c->changed_count && result == SB_OK; i++) {
        int tet = c->changed[i];
        sb_change_cell cell = ndli_remesh_cell(r, tet, tet);
        if (memcmp(cell.nodes, sb_body_cell_nodes(r->body, tet), 4 * sizeof(int)) != 0 ||
            ndli_remesh_is_renewed(c, cell.nodes))
            result = sb_body_change_replace_cell(to, tet, &cell, error);
    }
    return result;
}

/* Ends a change of the topology and makes the body's mesh follow. When the body refuses, the topology is as it was at
 * the begin. */
static sb_result ndli_remesh_commit(ndl_remesh *r, sb_error *error)
{
    ndli_topology_change change;
    sb_body_change *to = NULL;
    sb_result result;
    ndli_topology_end(r->mesh, &change);
    result = sb_body_change_begin(r->body, &to, error);
    if (result == SB_OK)
        result = ndli_remesh_send_nodes(r, &change, to, error);
    if (result == SB_OK)
        result = ndli_remesh_send_tets(r, &change, to, error);
    r->own = 1;
    if (result == SB_OK)
        result = sb_body_change_commit(to, error);
    r->own = 0;
    r->leaving_count = 0;
    if (result != SB_OK) {
        sb_body_change_cancel(to);
        ndli_topology_take_back(r->mesh, r->body);
    }
    r->mesh->x = sb_body_positions(r->body);
    return result;
}

/* Plans what the best candidate moves; *slide: the sliding node's number among the plans, or -1. Returns the first of
 * the smoothed nodes. */
static int ndli_remesh_plan_moves(ndl_remesh *r, int *slide)
{
    ndli_topology *mesh = r->mesh;
    const ndli_candidate *c = r->final;
    int first = mesh->change_count;
    for (int i = 0; i < r->move_count; i++)
        ndli_topology_plan(mesh, r->moves[i].node, r->moves[i].X, mesh->node_star[r->moves[i].node] / 4);
    *slide = c->slid_moves ? ndli_topology_plan(mesh, c->slid, c->slid_X, mesh->node_star[c->slid] / 4) : -1;
    return first;
}

/* Does the best candidate; *node: the one at X_new. */
static sb_result ndli_remesh_do(ndl_remesh *r, int start, int *node, sb_error *error)
{
    ndli_topology *mesh = r->mesh;
    ndli_needle *needle = r->needles + r->needle;
    const ndli_candidate *c = r->final;
    int plan, slide, first_move, depth = needle->depth, pool_count = needle->pool_count;
    ndli_split top;
    sb_result result;
    memset(&top, 0, sizeof top);
    if (c->undo) {
        top = needle->stack[depth - 1];
        memcpy(r->kept, needle->pool + top.first, (size_t)(pool_count - top.first) * sizeof(int));
    }
    ndli_topology_begin(mesh);
    plan = ndli_topology_plan(mesh, c->size == 1 ? c->simplex[0] : -1, c->X, start);
    first_move = ndli_remesh_plan_moves(r, &slide);
    if (c->undo)
        ndli_remesh_pop(r, r->needle);
    if (c->size == 1) {
        ndli_topology_move(mesh, plan);
    } else {
        int count = ndli_topology_cut(mesh, c->simplex, c->size, plan, r->groups);
        ndli_remesh_push_split(r, c, mesh->changes[plan].node, count);
    }
    *node = mesh->changes[plan].node;
    for (int i = 0; i < r->move_count; i++)
        ndli_topology_move(mesh, first_move + i);
    if (slide >= 0)
        ndli_topology_move(mesh, slide);
    result = ndli_remesh_commit(r, error);
    if (result != SB_OK) {
        needle->depth = depth;
        needle->pool_count = pool_count;
        if (c->undo) {
            needle->stack[depth - 1] = top;
            memcpy(needle->pool + top.first, r->kept, (size_t)(pool_count - top.first) * sizeof(int));
        }
        return result;
    }
    r->info.smoothed += r->move_count;
    r->info.operation = (ndl_operation)c->size;
    r->info.undone = c->undo;
    return SB_OK;
}

static void ndli_remesh_release_node(ndl_remesh *r, int node)
{
    r->mesh->node_flags[node] = (unsigned char)(r->mesh->node_flags[node] & ~NDLI_NODE_NEEDLE);
    if (!(r->mesh->node_flags[node] & NDLI_NODE_CREATED))
        r->mesh->owner[node] = -1;
}

static void ndli_remesh_add_node(ndl_remesh *r, int node)
{
    ndli_needle *needle = r->needles + r->needle;
    r->mesh->node_flags[node] |= NDLI_NODE_NEEDLE;
    r->mesh->owner[node] = r->needle;
    if (ndli_remesh_from_tip(needle, 0) != node)
        needle->nodes[needle->count++] = node;
}

/* ---- afterwards: release ---- */

static sb_real ndli_remesh_star_least(const ndli_topology *mesh, int node)
{
    sb_real least = SB_REAL_MAX;
    for (int k = mesh->node_star[node]; k >= 0; k = mesh->corner_next[k])
        least = sb_min(least, mesh->qualities[k / 4]);
    return least;
}

/* Worst quality about a node if it were at X; anything <= floor when that is not better than floor. */
static sb_real ndli_remesh_star_at(const ndli_topology *mesh, int node, sb_vec3 X, sb_real floor)
{
    sb_real least = SB_REAL_MAX;
    for (int k = mesh->node_star[node]; k >= 0 && least > floor; k = mesh->corner_next[k]) {
        const int *n = mesh->tets + 4 * (size_t)(k / 4);
        sb_vec3 p[4];
        for (int c = 0; c < 4; c++)
            p[c] = n[c] == node ? X : mesh->X[n[c]];
        least = sb_min(least, ndli_tet_quality(p[0], p[1], p[2], p[3]));
    }
    return least;
}

/* No tet about the node is another needle's. */
static int ndli_remesh_is_ours(const ndl_remesh *r, int node)
{
    for (int k = r->mesh->node_star[node]; k >= 0; k = r->mesh->corner_next[k])
        for (int c = 0; c < 4; c++)
            if (ndli_remesh_is_foreign(r, r->mesh->tets[4 * (size_t)(k / 4) + (size_t)c]))
                return 0;
    return 1;
}

/* 1: done; 0: the body refuses. */
static int ndli_remesh_move_node(ndl_remesh *r, int node, sb_vec3 X)
{
    ndli_topology *mesh = r->mesh;
    ndli_topology_begin(mesh);
    ndli_topology_move(mesh, ndli_topology_plan(mesh, node, X, mesh->node_star[node] / 4));
    return ndli_remesh_commit(r, NULL) == SB_OK;
}

/* Moves a released node as far towards its own place as the tets about it allow; 1: it moved. */
static int ndli_remesh_send_home(ndl_remesh *r, int node)
{
    ndli_topology *mesh = r->mesh;
    sb_vec3 way = sb_v3_sub(mesh->X0[node], mesh->X[node]);
    sb_real enough;
    if ((mesh->node_flags[node] & NDLI_NODE_NEEDLE) || !ndli_remesh_is_ours(r, node))
        return 0;
    enough = sb_min(ndli_remesh_star_least(mesh, node), r->def.release_above);
    for (int quarters = 4; quarters > 0; quarters--) {
        sb_vec3 X = quarters == 4 ? mesh->X0[node] : sb_v3_madd(mesh->X[node], (sb_real)quarters / 4, way);
        if (ndli_remesh_star_at(mesh, node, X, 0) >= enough) {
            int moved = ndli_remesh_move_node(r, node, X);
            r->info.released += moved;
            return moved;
        }
    }
    return 0;
}

/* Undoes a split whose node no needle needs, if that does no harm; 1: done. */
static int ndli_remesh_pop_spare(ndl_remesh *r, int index)
{
    const ndli_needle *needle = r->needles + index;
    const ndli_split *top = ndli_remesh_top(needle);
    int depth = needle->depth, pool_count = needle->pool_count;
    ndli_patch_tet parent;
    sb_real least = SB_REAL_MAX;
    if (!top || (r->mesh->node_flags[top->node] & NDLI_NODE_NEEDLE))
        return 0;
    for (int g = 0; g < top->count; g++) {
        ndli_remesh_parent(r, top, needle->pool + top->first + top->size * g, &parent);
        least = sb_min(least, parent.quality);
    }
    if (!(least >= sb_min(ndli_remesh_star_least(r->mesh, top->node), r->def.release_above)))
        return 0;
    ndli_topology_begin(r->mesh);
    ndli_remesh_pop(r, index);
    if (ndli_remesh_commit(r, NULL) == SB_OK)
        return 1;
    r->needles[index].depth = depth;
    r->needles[index].pool_count = pool_count;
    return 0;
}

/* A few nodes each time, in turn. */
static void ndli_remesh_release(ndl_remesh *r)
{
    ndli_topology *mesh = r->mesh;
    int tries = sbi_min_int(mesh->displaced_count, NDLI_RELEASES);
    for (int i = 0; i < r->def.max_needles; i++)
        while (ndli_remesh_pop_spare(r, i))
            continue;
    for (int i = 0; i < tries && mesh->displaced_count; i++) {
        r->release_cursor = (r->release_cursor + 1) % mesh->displaced_count;
        ndli_remesh_send_home(r, mesh->displaced[r->release_cursor]);
    }
}

static void ndli_remesh_tidy(ndl_remesh *r)
{
    const ndli_needle *needle = r->needles + r->needle;
    ndli_remesh_release(r);
    r->info.worst_quality = 1;
    for (int i = 0; i < 2 && i < needle->count; i++)
        r->info.worst_quality =
            sb_min(r->info.worst_quality, ndli_remesh_star_least(r->mesh, ndli_remesh_from_tip(needle, i)));
    r->info.X = r->mesh->X[ndli_remesh_from_tip(needle, 0)];
}

/* ---- one operation ---- */

/* The patch about the tip and X_new; holder and undone_holder: the tet that holds X_new, as it is and without the top
 * split. Returns 0 when memory is short. */
static int ndli_remesh_prepare(ndl_remesh *r, sb_vec3 X, int holder[4], int undone_holder[4], int *can_undo)
{
    const ndli_needle *needle = r->needles + r->needle;
    const ndli_split *top = ndli_remesh_top(needle);
    int tip = ndli_remesh_from_tip(needle, 0), good = 1;
    *can_undo = top && top->node == tip && needle->count > 1;
    r->here.count = r->undone.count = 0;
    for (int i = 0; i < 3; i++)
        good = good && ndli_remesh_gather(r, ndli_remesh_from_tip(needle, i));
    memcpy(undone_holder, holder, 4 * sizeof(int));
    if (*can_undo)
        ndli_remesh_undone_holder(r, top, X, undone_holder);
    for (int c = 0; c < 4; c++)
        good = good && ndli_remesh_gather(r, holder[c]) && ndli_remesh_gather(r, undone_holder[c]);
    ndli_remesh_end_gather(r);
    r->core_count = r->here.count;
    r->move_count = 0;
    if (!good)
        return 0;
    if (*can_undo)
        ndli_remesh_fill_undone(r, top);
    return 1;
}

static sb_result ndli_remesh_fail_operation(const ndl_remesh *r, sb_error *error)
{
    if (r->conflict >= 0)
        return sbi_fail_node(error, SB_ERROR_UNSUPPORTED, r->conflict,
                             "needle %d would change an element at node %d of needle %d: needles may share none",
                             r->needle, r->conflict, r->mesh->owner[r->conflict]);
    return sbi_fail_node(error, SB_ERROR_MESH, ndli_remesh_from_tip(r->needles + r->needle, 0),
                         "no operation puts a node at needle %d's tip and leaves sound tets: the step is too long",
                         r->needle);
}

/* Lets the nodes about the tip make way if the tets there are, or would be, worse than they should be. */
static int ndli_remesh_make_way(ndl_remesh *r, const int holders[2][4])
{
    r->before = SB_REAL_MAX;
    for (int i = 0; i < r->core_count; i++)
        r->before = sb_min(r->before, r->here.tets[i].quality);
    r->outcome = r->final[0].created.least;
    r->move_count = 0;
    if (r->def.max_smoothed == 0 || sb_min(r->before, r->outcome) >= r->def.smooth_below)
        return 1;
    return ndli_remesh_decide(r, holders, sb_min(r->before, r->def.smooth_below));
}

/* Takes the tip to X, which tet `start` holds. */
static sb_result ndli_remesh_operate(ndl_remesh *r, sb_vec3 X, int start, int penetrates, sb_error *error)
{
    ndli_needle *needle = r->needles + r->needle;
    int holders[2][4], *holder = holders[0], *undone_holder = holders[1];
    int tip = ndli_remesh_from_tip(needle, 0), can_undo, node, flags, owner, count;
    sb_result result;
    memcpy(holder, r->mesh->tets + 4 * (size_t)start, sizeof holders[0]);
    if (!ndli_remesh_prepare(r, X, holder, undone_holder, &can_undo) || !ndli_remesh_reserve(r))
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for remeshing about needle %d", r->needle);
    r->final_count = 0;
    r->conflict = -1;
    ndli_remesh_try_snap_tip(r, tip, X);
    if (penetrates)
        ndli_remesh_try_standard(r, &r->here, holder, 4, X, NDLI_AHEAD);
    if (can_undo)
        ndli_remesh_try_standard(r, &r->undone, undone_holder, 4, X, NDLI_UNDO);
    if (!penetrates && needle->count > 1) /* no split over one that could be undone: stacks would grow on the way out */
        ndli_remesh_try_standard(r, &r->here, holder, can_undo ? 1 : 4, X, NDLI_DROP);
    if (!r->final_count)
        return ndli_remesh_fail_operation(r, error);
    if (!ndli_remesh_make_way(r, (const int(*)[4])holders))
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for smoothing about needle %d", r->needle);
    if (r->outcome < sb_min(r->before, r->enough))
        return ndli_remesh_fail_operation(r, error);
    flags = r->mesh->node_flags[tip];
    owner = r->mesh->owner[tip];
    count = needle->count;
    if (r->final[0].undo || r->final[0].drops_tip) {
        needle->count--; /* the old tip is no part of the needle any more */
        ndli_remesh_release_node(r, tip);
    }
    result = ndli_remesh_do(r, start, &node, error);
    if (result != SB_OK) {
        needle->count = count;
        r->mesh->node_flags[tip] = (unsigned char)flags;
        r->mesh->owner[tip] = owner;
        return result;
    }
    ndli_remesh_add_node(r, node);
    r->info.substeps++;
    ndli_remesh_tidy(r);
    return SB_OK;
}

/* ---- calls ---- */

static sb_result ndli_remesh_begin_call(ndl_remesh *r, int needle, int is_in, ndl_remesh_info *info, sb_error *error)
{
    sb_result result;
    if (!r)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "remesh is NULL");
    if (needle < 0 || needle >= r->def.max_needles)
        return sbi_fail(error, SB_ERROR_INDEX, "needle %d of %d", needle, r->def.max_needles);
    result = ndli_remesh_look(r, error);
    if (result != SB_OK)
        return result;
    if (is_in >= 0 && (r->needles[needle].count > 0) != is_in)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "needle %d is %s the tissue", needle,
                        is_in ? "not in" : "already in");
    r->needle = needle;
    r->conflict = -1;
    r->enough = 0;
    memset(&r->info, 0, sizeof r->info);
    r->info.worst_quality = 1;
    if (info)
        *info = r->info;
    return SB_OK;
}

NDL_API sb_real ndl_remesh_limit(const ndl_remesh *remesh, int needle)
{
    const ndli_topology *mesh;
    sb_real shortest = SB_REAL_MAX;
    int tip, behind;
    if (!remesh || needle < 0 || needle >= remesh->def.max_needles || !remesh->needles[needle].count)
        return 0;
    mesh = remesh->mesh;
    tip = ndli_remesh_from_tip(remesh->needles + needle, 0);
    behind = ndli_remesh_from_tip(remesh->needles + needle, 1);
    for (int k = mesh->node_star[tip]; k >= 0; k = mesh->corner_next[k])
        for (int c = 0; c < 4; c++) {
            int node = mesh->tets[4 * (size_t)(k / 4) + (size_t)c];
            if (node != tip && node != behind)
                shortest = sb_min(shortest, sb_v3_norm(sb_v3_sub(mesh->X[node], mesh->X[tip])));
        }
    return shortest / 2;
}

static sb_result ndli_remesh_advance(ndl_remesh *r, sb_vec3 X, int penetrates, sb_error *error)
{
    const ndli_topology *mesh = r->mesh;
    sb_real share = 1; /* of the limit, smaller while no operation is found */
    for (int i = 0; i < NDLI_MAX_SUBSTEPS; i++) {
        int tip = ndli_remesh_from_tip(r->needles + r->needle, 0), last, tet;
        sb_vec3 way = sb_v3_sub(X, mesh->X[tip]), to = X;
        sb_real length = sb_v3_norm(way), limit = share * ndl_remesh_limit(r, r->needle);
        sb_result result;
        last = !(length > limit);
        if (!last)
            to = sb_v3_madd(mesh->X[tip], limit / length, way);
        tet = ndli_topology_find(mesh, mesh->X, to, mesh->node_star[tip] / 4, NULL);
        if (tet < 0) {
            r->info.outside = 1;
            return SB_OK;
        }
        result = ndli_remesh_operate(r, to, tet, penetrates, error);
        if (result == SB_OK && last)
            return SB_OK;
        if (result == SB_ERROR_MESH && share > (sb_real)0.01) {
            share /= 4;
            continue;
        }
        if (result != SB_OK)
            return result;
        share = 1;
    }
    return sbi_fail(error, SB_ERROR_MESH, "needle %d has not come there in %d substeps", r->needle,
                    (int)NDLI_MAX_SUBSTEPS);
}

static sb_result ndli_remesh_move_tip(ndl_remesh *r, int needle, sb_vec3 X, int penetrates, ndl_remesh_info *info,
                                      sb_error *error)
{
    sb_result result = ndli_remesh_begin_call(r, needle, 1, info, error);
    if (result != SB_OK)
        return result;
    if (!sb_v3_is_finite(X))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the place for needle %d's tip is not finite", needle);
    r->info.X = r->mesh->X[ndli_remesh_from_tip(r->needles + needle, 0)];
    result = ndli_remesh_advance(r, X, penetrates, error);
    if (info)
        *info = r->info;
    return result;
}

NDLI_API sb_result ndli_remesh_put_first(ndl_remesh *remesh, int needle, sb_vec3 X, sb_real enough,
                                         ndl_remesh_info *info)
{
    const ndli_topology *mesh = remesh->mesh;
    sb_result result = ndli_remesh_begin_call(remesh, needle, 1, info, NULL);
    int tip, tet;
    if (result != SB_OK)
        return result;
    tip = ndli_remesh_from_tip(remesh->needles + needle, 0);
    tet = ndli_topology_find(mesh, mesh->X, X, mesh->node_star[tip] / 4, NULL);
    remesh->enough = enough;
    result = tet < 0 ? SB_ERROR_MESH : ndli_remesh_operate(remesh, X, tet, 1, NULL);
    if (info)
        *info = remesh->info;
    return result;
}

NDL_API sb_result ndl_remesh_penetrate(ndl_remesh *remesh, int needle, sb_vec3 X_new, ndl_remesh_info *info,
                                       sb_error *error)
{
    sb_result result;
    ndli_remesh_hush(remesh);
    result = ndli_remesh_move_tip(remesh, needle, X_new, 1, info, error);
    ndli_remesh_tell_move(remesh, needle, X_new, 1, result);
    return result;
}

NDL_API sb_result ndl_remesh_retract(ndl_remesh *remesh, int needle, sb_vec3 X_new, ndl_remesh_info *info,
                                     sb_error *error)
{
    ndl_remesh_info done;
    sb_result result;
    ndli_remesh_hush(remesh);
    result = ndli_remesh_move_tip(remesh, needle, X_new, 0, &done, error);
    if (result == SB_OK && done.outside)
        result = ndl_remesh_withdraw(remesh, needle, NULL, error);
    ndli_remesh_tell_move(remesh, needle, X_new, 0, result);
    if (result == SB_OK && done.outside)
        done.worst_quality = 1;
    if (info && remesh)
        *info = done;
    return result;
}

/* ---- in and out ---- */

/* 1 when X lies in the planes of all surface faces that the trial changes: then the surface keeps its shape. */
static int ndli_remesh_keeps_skin(const ndl_remesh *r)
{
    const ndli_candidate *t = &r->trial;
    sb_real flat = sb_sqrt(SB_EPSILON) * sb_sqrt(sb_sqrt(SB_EPSILON)); /* volume is kept to the last digits but few */
    for (int i = 0; i < r->here.count; i++) {
        const ndli_patch_tet *tet = r->here.tets + i;
        if (!ndli_remesh_holds(tet->nodes, t->simplex, t->size))
            continue;
        for (int c = 0; c < 4; c++) {
            sb_vec3 p[3], n;
            sb_real size;
            int k = 0, part = 0;
            for (int j = 0; j < t->size; j++)
                part |= tet->nodes[c] == t->simplex[j];
            if (part || !(tet->skin >> c & 1))
                continue;
            for (int j = 0; j < 4; j++)
                if (j != c)
                    p[k++] = r->mesh->X[tet->nodes[j]];
            n = sb_v3_cross(sb_v3_sub(p[1], p[0]), sb_v3_sub(p[2], p[0]));
            size = sb_v3_norm(n);
            if (!(sb_abs(sb_v3_dot(n, sb_v3_sub(t->X, p[0]))) <= flat * size * sb_sqrt(size)))
                return 0;
        }
    }
    return 1;
}

static void ndli_remesh_try_entry(ndl_remesh *r, const int *simplex, int size, sb_vec3 X)
{
    ndli_candidate *t = &r->trial;
    memcpy(t->simplex, simplex, (size_t)size * sizeof(int));
    t->size = size;
    t->X = X;
    t->undo = t->drops_tip = t->slid_moves = 0;
    t->slid = -1;
    if (size == 1 && memcmp(&X, r->mesh->X + simplex[0], sizeof X) != 0 &&
        (r->mesh->node_flags[simplex[0]] & (NDLI_NODE_FIXED | NDLI_NODE_INTERFACE)))
        return;
    if (!ndli_remesh_keeps_skin(r))
        return;
    r->info.candidates++;
    if (!ndli_remesh_collect(r, &r->here) || ndli_remesh_is_lost(r))
        return;
    ndli_remesh_rank(r);
}

/* Nodes and edges of the face not further than `reach` from X, with the entry on them. */
static void ndli_remesh_try_slipped(ndl_remesh *r, const int face[3], sb_vec3 X, sb_real reach)
{
    for (int i = 0; i < 3; i++) {
        int edge[2];
        sb_vec3 a = r->mesh->X[face[i]], along, foot;
        sb_real s;
        edge[0] = face[i];
        edge[1] = face[(i + 1) % 3];
        along = sb_v3_sub(r->mesh->X[edge[1]], a);
        s = sb_v3_dot(sb_v3_sub(X, a), along) / sb_v3_dot(along, along);
        foot = sb_v3_madd(a, s, along);
        if (s > 0 && s < 1 && sb_v3_norm(sb_v3_sub(X, foot)) <= reach)
            ndli_remesh_try_entry(r, edge, 2, foot);
        if (sb_v3_norm(sb_v3_sub(X, a)) <= reach)
            ndli_remesh_try_entry(r, face + i, 1, a);
    }
}

/* Leaves the best entry first among the finalists, with what has to make way for it; 0: no memory. */
static int ndli_remesh_try_entries(ndl_remesh *r, const int holder[4], const int face[3], sb_vec3 X, sb_real slip)
{
    int holders[2][4];
    sb_real longest = 0;
    memcpy(holders[0], holder, sizeof holders[0]);
    memcpy(holders[1], holder, sizeof holders[1]);
    for (int set = 1; set < 8; set++) {
        int simplex[3], size = 0;
        for (int c = 0; c < 3; c++)
            if (set >> c & 1)
                simplex[size++] = face[c];
        ndli_remesh_try_entry(r, simplex, size, X);
    }
    if (r->final_count && !ndli_remesh_make_way(r, (const int(*)[4])holders))
        return 0;
    for (int i = 0; i < 3; i++)
        longest = sb_max(longest, sb_v3_norm(sb_v3_sub(r->mesh->X[face[i]], r->mesh->X[face[(i + 1) % 3]])));
    if (r->final_count && r->outcome >= sb_min(r->before, r->def.smooth_below / 2))
        return 1;
    r->here.count = r->core_count; /* making way has widened it */
    ndli_remesh_try_slipped(r, face, X, slip * longest);
    return !r->final_count || ndli_remesh_make_way(r, (const int(*)[4])holders);
}

static sb_result ndli_remesh_check_hit(const ndl_remesh *r, const ndl_surface_hit *hit, sb_error *error)
{
    const ndli_topology *mesh = r->mesh;
    if (!hit)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "hit is NULL");
    if (hit->tet < 0 || hit->tet >= mesh->tet_end || mesh->tets[4 * (size_t)hit->tet] < 0 || hit->face < 0 ||
        hit->face > 3)
        return sbi_fail(error, SB_ERROR_INDEX, "face %d of tet %d", hit->face, hit->tet);
    if (mesh->neighbours[4 * (size_t)hit->tet + (size_t)hit->face] >= 0)
        return sbi_fail_element(error, SB_ERROR_ARGUMENT, hit->tet, "face %d of tet %d is not on the surface",
                                hit->face, hit->tet);
    if (!sb_v3_is_finite(hit->X))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the point of the puncture is not finite");
    return SB_OK;
}

static sb_result ndli_remesh_do_puncture(ndl_remesh *r, const ndl_surface_hit *hit, sb_real slip, sb_error *error)
{
    int holder[4], face[3], k = 0, good = 1, node = -1;
    sb_result result = SB_OK;
    memcpy(holder, r->mesh->tets + 4 * (size_t)hit->tet, sizeof holder);
    for (int c = 0; c < 4; c++)
        if (c != hit->face)
            face[k++] = holder[c];
    r->here.count = r->undone.count = r->move_count = 0;
    for (int c = 0; c < 3; c++)
        good = good && ndli_remesh_gather(r, face[c]);
    ndli_remesh_end_gather(r);
    r->core_count = r->here.count;
    if (!good || !ndli_remesh_reserve(r))
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for remeshing about needle %d", r->needle);
    r->final_count = 0;
    if (!ndli_remesh_try_entries(r, holder, face, hit->X, slip))
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for smoothing about needle %d", r->needle);
    if (!r->final_count && r->conflict >= 0)
        return ndli_remesh_fail_operation(r, error);
    if (!r->final_count)
        return sbi_fail_element(error, SB_ERROR_MESH, hit->tet, "no sound way to puncture tet %d at that point",
                                hit->tet);
    if (r->final[0].size == 1 && memcmp(&r->final[0].X, r->mesh->X + r->final[0].simplex[0], sizeof(sb_vec3)) == 0)
        node = r->final[0].simplex[0];
    else
        result = ndli_remesh_do(r, hit->tet, &node, error);
    if (result != SB_OK)
        return result;
    r->mesh->node_flags[node] |= NDLI_NODE_BOUNDARY;
    ndli_remesh_add_node(r, node);
    r->info.substeps = 1;
    ndli_remesh_tidy(r);
    return SB_OK;
}

NDLI_API sb_result ndli_remesh_puncture_within(ndl_remesh *remesh, int needle, const ndl_surface_hit *hit, sb_real slip,
                                               ndl_remesh_info *info, sb_error *error)
{
    sb_result result = ndli_remesh_begin_call(remesh, needle, 0, info, error);
    if (result == SB_OK)
        result = ndli_remesh_check_hit(remesh, hit, error);
    if (result == SB_OK)
        result = ndli_remesh_do_puncture(remesh, hit, slip, error);
    if (result == SB_OK && info)
        *info = remesh->info;
    return result;
}

NDL_API sb_result ndl_remesh_puncture(ndl_remesh *remesh, int needle, const ndl_surface_hit *hit, ndl_remesh_info *info,
                                      sb_error *error)
{
    sb_real slip = remesh ? remesh->def.entry_slip : 0;
    sb_result result;
    ndli_remesh_hush(remesh);
    result = ndli_remesh_puncture_within(remesh, needle, hit, slip, info, error);
    ndli_remesh_tell_puncture(remesh, needle, hit, slip, result);
    return result;
}

/* The whole way back at once: whatever lies between, the mesh that comes out is the original one. */
static sb_result ndli_remesh_restore(ndl_remesh *r, sb_error *error)
{
    ndli_topology *mesh = r->mesh;
    sb_result result;
    ndli_topology_begin(mesh);
    for (int i = 0; i < mesh->displaced_count; i++) {
        int node = mesh->displaced[i];
        ndli_topology_plan(mesh, node, mesh->X0[node], mesh->node_star[node] / 4);
    }
    for (int i = 0; i < r->def.max_needles; i++)
        for (r->needles[i].undone = 0; r->needles[i].depth; r->needles[i].undone++)
            ndli_remesh_pop(r, i);
    for (int i = 0; i < mesh->change_count; i++)
        ndli_topology_move(mesh, i);
    result = mesh->change_count || mesh->node_event_count ? ndli_remesh_commit(r, error) : SB_OK;
    for (int i = 0; i < r->def.max_needles && result != SB_OK; i++) {
        ndli_needle *needle = r->needles + i;
        needle->depth = needle->undone;
        if (needle->depth) {
            const ndli_split *top = needle->stack + needle->depth - 1;
            needle->pool_count = top->first + top->size * top->count;
        }
    }
    if (result == SB_OK)
        r->info.released += mesh->change_count;
    return result;
}

/* As much of it as leaves sound tets: other needles are still in. */
static void ndli_remesh_restore_partly(ndl_remesh *r)
{
    int progress = 1;
    for (int round = 0; progress && round < 16; round++) {
        progress = 0;
        for (int i = 0; i < r->def.max_needles; i++)
            while (ndli_remesh_pop_spare(r, i))
                progress = 1;
        for (int i = r->mesh->displaced_count - 1; i >= 0; i--)
            if (i < r->mesh->displaced_count)
                progress |= ndli_remesh_send_home(r, r->mesh->displaced[i]);
    }
}

/* The needle's nodes in the tissue are on it (in), or are like others. */
static void ndli_remesh_mark(ndl_remesh *r, int needle, int in)
{
    const ndli_needle *n = r->needles + needle;
    for (int i = 0; i < n->count; i++) {
        if (in) {
            r->mesh->node_flags[n->nodes[i]] |= NDLI_NODE_NEEDLE;
            r->mesh->owner[n->nodes[i]] = needle;
        } else {
            ndli_remesh_release_node(r, n->nodes[i]);
        }
    }
}

static sb_result ndli_remesh_do_withdraw(ndl_remesh *remesh, int needle, ndl_remesh_info *info, sb_error *error)
{
    sb_result result = ndli_remesh_begin_call(remesh, needle, -1, info, error);
    int others = 0, count;
    if (result != SB_OK || !remesh->needles[needle].count)
        return result;
    count = remesh->needles[needle].count;
    ndli_remesh_mark(remesh, needle, 0);
    remesh->needles[needle].count = 0;
    for (int i = 0; i < remesh->def.max_needles; i++)
        others += remesh->needles[i].count > 0;
    if (others)
        ndli_remesh_restore_partly(remesh);
    else
        result = ndli_remesh_restore(remesh, error);
    if (result != SB_OK) {
        remesh->needles[needle].count = count;
        ndli_remesh_mark(remesh, needle, 1);
        return result;
    }
    remesh->info.outside = 1;
    if (info)
        *info = remesh->info;
    return SB_OK;
}

NDL_API sb_result ndl_remesh_withdraw(ndl_remesh *remesh, int needle, ndl_remesh_info *info, sb_error *error)
{
    sb_result result;
    ndli_remesh_hush(remesh);
    result = ndli_remesh_do_withdraw(remesh, needle, info, error);
    ndli_remesh_tell_withdraw(remesh, needle, result);
    return result;
}

NDLI_API void ndli_remesh_let_go(ndl_remesh *remesh, int needle)
{
    if (ndl_remesh_withdraw(remesh, needle, NULL, NULL) == SB_OK)
        return;
    if (!remesh->stale)
        ndli_remesh_mark(remesh, needle, 0);
    remesh->needles[needle].count = 0;
}

NDL_API const int *ndl_remesh_nodes(const ndl_remesh *remesh, int needle, int *count)
{
    int known = remesh && needle >= 0 && needle < remesh->def.max_needles && remesh->needles[needle].count;
    if (count)
        *count = known ? remesh->needles[needle].count : 0;
    return known ? remesh->needles[needle].nodes : NULL;
}

NDL_API int ndl_remesh_material_point(const ndl_remesh *remesh, int needle, sb_vec3 x, sb_vec3 *X)
{
    const ndli_topology *mesh;
    int count, start, tet;
    const int *nodes = ndl_remesh_nodes(remesh, needle, &count);
    sb_real most = -SB_REAL_MAX;
    if (!nodes || !X || !sb_v3_is_finite(x))
        return 0;
    mesh = remesh->mesh;
    start = mesh->node_star[nodes[count - 1]] / 4;
    tet = ndli_topology_find_in_space(mesh, x, start);
    for (int k = tet < 0 ? mesh->node_star[nodes[count - 1]] : -1; k >= 0; k = mesh->corner_next[k]) {
        const int *n = mesh->tets + 4 * (size_t)(k / 4);
        sb_real w[4], least;
        ndli_tet_weights(mesh->x[n[0]], mesh->x[n[1]], mesh->x[n[2]], mesh->x[n[3]], x, w);
        least = sb_min(sb_min(w[0], w[1]), sb_min(w[2], w[3]));
        if (least > most) {
            most = least;
            start = k / 4;
        }
    }
    {
        const int *n = mesh->tets + 4 * (size_t)(tet < 0 ? start : tet);
        sb_real w[4];
        ndli_tet_weights(mesh->x[n[0]], mesh->x[n[1]], mesh->x[n[2]], mesh->x[n[3]], x, w);
        *X = sb_v3(0, 0, 0);
        for (int c = 0; c < 4; c++)
            *X = sb_v3_madd(*X, w[c], mesh->X[n[c]]);
    }
    return tet >= 0;
}

NDL_API int ndl_remesh_split_count(const ndl_remesh *remesh, int needle)
{
    return remesh && needle >= 0 && needle < remesh->def.max_needles ? remesh->needles[needle].depth : 0;
}

NDL_API int ndl_remesh_hit(const ndl_remesh *remesh, sb_vec3 from, sb_vec3 to, ndl_surface_hit *hit)
{
    return remesh && !remesh->stale ? ndli_topology_hit(remesh->mesh, from, to, hit) : 0;
}

NDL_API void ndl_remesh_quality(const ndl_remesh *remesh, sb_real *worst_quality, sb_real *min_dihedral,
                                sb_real *max_dihedral)
{
    if (remesh && !remesh->stale)
        ndli_topology_quality(remesh->mesh, worst_quality, min_dihedral, max_dihedral);
}

NDL_API int ndl_remesh_is_original(const ndl_remesh *remesh)
{
    return remesh && (remesh->stale || ndli_topology_is_original(remesh->mesh));
}

/* Whether the body has these tets at these places. */
static sb_result ndli_remesh_check_cells(const ndl_remesh *r, sb_error *error)
{
    const ndli_topology *mesh = r->mesh;
    const sb_vec3 *X = sb_body_rest_positions(r->body);
    for (int t = 0; t < mesh->tet_end; t++) {
        const int *own = mesh->tets + 4 * (size_t)t, *cell = sb_body_cell_nodes(r->body, t);
        if ((own[0] >= 0) != (cell != NULL) || (cell && memcmp(own, cell, 4 * sizeof(int)) != 0))
            return sbi_fail_element(error, SB_ERROR_MESH, t, "tet %d is not the body's", t);
        for (int c = 0; cell && c < 4; c++)
            if (memcmp(X + cell[c], mesh->X + cell[c], sizeof *X) != 0)
                return sbi_fail_node(error, SB_ERROR_MESH, cell[c], "node %d is elsewhere in the body", cell[c]);
    }
    return SB_OK;
}

NDL_API sb_result ndl_remesh_check(const ndl_remesh *remesh, sb_error *error)
{
    sb_result result;
    if (!remesh)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "remesh is NULL");
    if (remesh->stale)
        return SB_OK;
    result = ndli_topology_check(remesh->mesh, error);
    return result == SB_OK ? ndli_remesh_check_cells(remesh, error) : result;
}

/* ---- recording ---- */

static sb_result ndli_remesh_repeat(ndl_remesh *r, const int *ints, size_t int_count, const sb_real *reals,
                                    size_t real_count, sb_error *error)
{
    int needle = ints[1];
    if (ints[0] == NDLI_COMMAND_PUNCTURE && int_count == 5 && real_count == 5) {
        ndl_surface_hit hit;
        hit.tet = ints[3], hit.face = ints[4], hit.along = reals[0], hit.X = sb_v3(reals[1], reals[2], reals[3]);
        return ndli_remesh_puncture_within(r, needle, &hit, reals[4], NULL, error);
    }
    if (ints[0] == NDLI_COMMAND_PENETRATE && real_count == 3)
        return ndl_remesh_penetrate(r, needle, sb_v3(reals[0], reals[1], reals[2]), NULL, error);
    if (ints[0] == NDLI_COMMAND_RETRACT && real_count == 3)
        return ndl_remesh_retract(r, needle, sb_v3(reals[0], reals[1], reals[2]), NULL, error);
    if (ints[0] == NDLI_COMMAND_WITHDRAW)
        return ndl_remesh_withdraw(r, needle, NULL, error);
    return sbi_fail(error, SB_ERROR_FORMAT, "the recording holds a command of a remesher that there is not");
}

static sb_result ndli_remesh_replay_part(void *user, const int *ints, size_t int_count, const sb_real *reals,
                                         size_t real_count, sb_error *error)
{
    ndl_remesh *r = (ndl_remesh *)user;
    sb_result result;
    if (int_count < 3)
        return sbi_fail(error, SB_ERROR_FORMAT, "the recording holds a command of a remesher that ends early");
    if (ints[0] == NDLI_COMMAND_MADE || ints[0] == NDLI_COMMAND_GONE)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "the recorded body's remesher was %s while it was recorded: what "
                        "follows cannot be played",
                        ints[0] == NDLI_COMMAND_MADE ? "made" : "destroyed");
    ndli_remesh_hush(r);
    result = ndli_remesh_repeat(r, ints, int_count, reals, real_count, error);
    ndli_remesh_tell(r, result == SB_ERROR_FORMAT ? NULL : ints, int_count, reals, real_count);
    if (result == SB_ERROR_FORMAT)
        return result;
    if ((int)result != ints[2])
        return sbi_fail(error, SB_ERROR_STATE, "a call of the remesher returns '%s' where '%s' was recorded",
                        sb_result_string(result), sb_result_string((sb_result)ints[2]));
    return SB_OK;
}

/* ---- creation ---- */

static sb_result ndli_remesh_check_body(const sb_body *body, sb_error *error)
{
    if (sbi_body_mesh(body).element_type != SB_TET4)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "needles and remeshers need a body of SB_TET4: its elements are others");
    if (sbi_body_node_slots(body).room == 0)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "needles and remeshers change the mesh: make the body with def.slack > 0");
    return SB_OK;
}

static sb_result ndli_remesh_fill(ndl_remesh *r, sb_error *error)
{
    sb_body_listener listener;
    sb_result result;
    memset(&listener, 0, sizeof listener);
    listener.user = r;
    listener.reserve = ndli_remesh_hear;
    listener.follow = ndli_remesh_follow;
    r->needles = (ndli_needle *)sbi_alloc_zeroed(&r->def.allocator, (size_t)r->def.max_needles, sizeof(ndli_needle));
    if (!r->needles || !ndli_remesh_scratch(r, 256) || !ndli_topology_read(r->mesh, r->body))
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for a remesher of %d needles", r->def.max_needles);
    result = sb_body_listen(r->body, &listener, &r->listener, error);
    return result == SB_OK ? ndli_remesh_join(r, ndli_remesh_replay_part, error) : result;
}

NDL_API sb_result ndl_remesh_create(const ndl_remesh_def *def, ndl_remesh **remesh, sb_error *error)
{
    ndl_remesh *made;
    sb_result result = ndli_remesh_check_def(def, error);
    if (result == SB_OK && !remesh)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "remesh is NULL");
    if (result == SB_OK)
        result = ndli_remesh_check_body(def->body, error);
    if (result != SB_OK)
        return result;
    made = (ndl_remesh *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "out of memory for a remesher of %d needles", def->max_needles);
    made->def = *def;
    made->body = def->body;
    made->mesh = &made->topology;
    made->topology.allocator = def->allocator;
    result = ndli_remesh_fill(made, error);
    if (result != SB_OK) {
        ndl_remesh_destroy(made);
        return result;
    }
    *remesh = made;
    return SB_OK;
}

NDL_API void ndl_remesh_destroy(ndl_remesh *remesh)
{
    sb_allocator allocator;
    if (!remesh)
        return;
    allocator = remesh->def.allocator;
    ndli_remesh_leave(remesh);
    if (remesh->listener)
        sb_body_unlisten(remesh->body, remesh->listener);
    ndli_remesh_free_knowledge(remesh);
    sbi_free(&allocator, remesh->scratch);
    sbi_free(&allocator, remesh);
}

NDL_API sb_result ndl_remesh_reserve(ndl_remesh *remesh, int needle, int nodes, sb_error *error)
{
    ndli_needle *n;
    int counts[3];
    if (!remesh || nodes < 0 || nodes > INT_MAX / (4 * NDLI_USUAL_POOL))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "no memory can be taken for a needle of %d nodes", nodes);
    if (needle < 0 || needle >= remesh->def.max_needles)
        return sbi_fail(error, SB_ERROR_INDEX, "needle %d of %d", needle, remesh->def.max_needles);
    n = remesh->needles + needle;
    counts[0] = counts[1] = nodes;
    counts[2] = (nodes + 1) * NDLI_USUAL_POOL + 2 * NDLI_USUAL_PATCH + 8;
    if (!ndli_remesh_make_room(remesh, n, counts) || !ndli_remesh_scratch(remesh, NDLI_USUAL_PATCH))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a needle of %d nodes", nodes);
    return SB_OK;
}

/* ==== src/needle/steer_path.h ==== */
/* steer_path: poses, helices, and how near paths come to obstacles, in double. Floor 6, internal: the planner's and the
 * controller's. */
#ifndef NDL_STEER_PATH_H
#define NDL_STEER_PATH_H


#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
typedef struct ndli_pose {
    ndli_v3 p, m1, m2, t;
} ndli_pose;

/* The end of a helix from a pose at the origin with axes x, y, z, and its derivatives: d/ds is the tangent. */
typedef struct ndli_helix_end {
    ndli_v3 p, ds, dw;
} ndli_helix_end;

/* Obstacles and the distance that paths keep from them. */
typedef struct ndli_field {
    const ndl_obstacle *obstacles;
    int count;
    double clearance;
    double resolution; /* m: least step along a path; between two of them it may be resolution/2 nearer */
} ndli_field;

/* SB_ERROR_NOT_FINITE, or SB_ERROR_ARGUMENT for a frame that is none. */
NDLI_API sb_result ndli_pose_read(const ndl_tip_pose *tip, ndli_pose *pose);
NDLI_API ndl_tip_pose ndli_pose_write(const ndli_pose *pose);
NDLI_API ndli_pose ndli_pose_turn(const ndli_pose *pose, double angle);
NDLI_API ndli_pose ndli_pose_helix(const ndli_pose *pose, double k, double w, double s);
NDLI_API ndli_v3 ndli_pose_out(const ndli_pose *pose, ndli_v3 local); /* world point of a local one */
NDLI_API ndli_v3 ndli_pose_in(const ndli_pose *pose, ndli_v3 point);  /* local point of a world one */
NDLI_API ndli_v3 ndli_helix_point(double k, double w, double s);      /* local */
NDLI_API ndli_helix_end ndli_helix_derive(double k, double w, double s);

NDLI_API double ndli_field_distance(const ndli_field *field, ndli_v3 p); /* DBL_MAX without obstacles */
/* Follows a helix until an obstacle is nearer than clearance - slack s^3: the length that is free, at most `length`.
 * *nearest is lowered to what the distance along that length proves to be. */
NDLI_API double ndli_field_march(const ndli_field *field, const ndli_pose *pose, double k, double w, double length,
                                 double slack, double *nearest);

/* ---- the planner's, for the controller ---- */
NDLI_API sb_result ndli_obstacle_check(const ndl_obstacle *o, int i, sb_error *error); /* i: its name in messages */
NDLI_API sb_result ndli_plan_check(const ndl_plan_def *def, sb_error *error);
/* The plan whose pieces aim at the waypoints in turn, then at the target, with the curvature, limits and tolerance of
 * def; `sense` is the sign of twist to keep, or 0. Where it meets an obstacle nearer than `clearance` it is cut off
 * there. Returns whether it is clear. */
NDLI_API int ndli_plan_aim(const ndl_plan_def *def, double clearance, const ndli_pose *pose, const sb_vec3 *waypoints,
                           int waypoint_count, ndli_v3 target, double sense, ndl_plan *plan);
NDLI_API void ndli_plan_search(const ndl_plan_def *def, const ndli_pose *pose, ndli_v3 target, double sense,
                               ndl_plan *plan);
#endif

#endif /* NDL_STEER_PATH_H */

/* ==== src/needle/steer_path.c ==== */
/* steer_path: helices, what a bevel does, and distances of paths from obstacles. */

/* ---- poses ---- */

NDLI_API sb_result ndli_pose_read(const ndl_tip_pose *tip, ndli_pose *pose)
{
    const ndl_frame *f = &tip->frame;
    ndli_v3 m1 = ndli_from(f->m1), m2 = ndli_from(f->m2), t = ndli_from(f->t), off;
    double length;
    if (!sb_v3_is_finite(tip->position) || !sb_v3_is_finite(f->m1) || !sb_v3_is_finite(f->m2) || !sb_v3_is_finite(f->t))
        return SB_ERROR_NOT_FINITE;
    off = ndli_sub(ndli_cross(m1, m2), t);
    if (!(fabs(ndli_norm(t) - 1) < 1e-3) || !(fabs(ndli_norm(m2) - 1) < 1e-3) || !(fabs(ndli_norm(m1) - 1) < 1e-3) ||
        !(ndli_norm(off) < 1e-3) || !(fabs(ndli_dot(m1, m2)) < 1e-3))
        return SB_ERROR_ARGUMENT;
    length = ndli_norm(t);
    pose->p = ndli_from(tip->position);
    pose->t = ndli_scale(1 / length, t);
    m2 = ndli_madd(m2, -ndli_dot(m2, pose->t), pose->t);
    pose->m2 = ndli_scale(1 / ndli_norm(m2), m2);
    pose->m1 = ndli_cross(pose->m2, pose->t);
    return SB_OK;
}

NDLI_API ndl_tip_pose ndli_pose_write(const ndli_pose *pose)
{
    ndl_tip_pose tip;
    tip.position = ndli_to(pose->p);
    tip.frame.m1 = ndli_to(pose->m1);
    tip.frame.m2 = ndli_to(pose->m2);
    tip.frame.t = ndli_to(pose->t);
    return tip;
}

static ndli_v3 ndli_pose_along(const ndli_pose *pose, ndli_v3 local)
{
    return ndli_madd(ndli_madd(ndli_scale(local.x, pose->m1), local.y, pose->m2), local.z, pose->t);
}

NDLI_API ndli_v3 ndli_pose_out(const ndli_pose *pose, ndli_v3 local)
{
    return ndli_add(pose->p, ndli_pose_along(pose, local));
}

NDLI_API ndli_v3 ndli_pose_in(const ndli_pose *pose, ndli_v3 point)
{
    ndli_v3 d = ndli_sub(point, pose->p);
    return ndli_v(ndli_dot(d, pose->m1), ndli_dot(d, pose->m2), ndli_dot(d, pose->t));
}

NDLI_API ndli_pose ndli_pose_turn(const ndli_pose *pose, double angle)
{
    ndli_pose r = *pose;
    double s, c;
    sbi_dense_sin_cos(angle, &s, &c);
    r.m1 = ndli_madd(ndli_scale(c, pose->m1), s, pose->m2);
    r.m2 = ndli_madd(ndli_scale(c, pose->m2), -s, pose->m1);
    return r;
}

/* ---- helices ---- */

/* sin(a)/a, (1 - cos a)/a^2, (a - sin a)/a^3 for a^2 = `square`, and (1/a) d/da of the last two. */
typedef struct ndli_helix_factors {
    double c0, c1, c2, d1, d2;
} ndli_helix_factors;

/* Below half a radian by series: the quotients would lose digits. */
static ndli_helix_factors ndli_helix_series(double a)
{
    ndli_helix_factors q;
    q.c2 = 1.0 / 6 - a * (1.0 / 120 - a * (1.0 / 5040 - a * (1.0 / 362880 - a * (1.0 / 39916800 - a / 6227020800.0))));
    q.c1 = 0.5 - a * (1.0 / 24 - a * (1.0 / 720 - a * (1.0 / 40320 - a * (1.0 / 3628800 - a / 479001600.0))));
    q.c0 = 1 - a * q.c2;
    q.d1 = -1.0 / 12 + a * (1.0 / 180 - a * (1.0 / 6720 - a * (1.0 / 453600 - a / 47900160.0)));
    q.d2 = -1.0 / 60 + a * (1.0 / 1260 - a * (1.0 / 60480 - a * (1.0 / 4989600 - a / 622702080.0)));
    return q;
}

static ndli_helix_factors ndli_helix_factors_of(double square)
{
    ndli_helix_factors q;
    double a, s, c;
    if (square < 0.25)
        return ndli_helix_series(square);
    a = sqrt(square);
    sbi_dense_sin_cos(a, &s, &c);
    q.c0 = s / a;
    q.c1 = (1 - c) / square;
    q.c2 = (1 - q.c0) / square;
    q.d1 = (q.c0 - 2 * q.c1) / square;
    q.d2 = (q.c1 - 3 * q.c2) / square;
    return q;
}

/* The frame turns by the rotation vector s (-k, 0, w); p = s (I + c1 [v] + c2 [v]^2) (0, 0, 1). */
static ndli_v3 ndli_helix_point_of(const ndli_helix_factors *q, double k, double w, double s)
{
    double b = k * s;
    return ndli_v(-s * q->c2 * b * (w * s), s * q->c1 * b, s * (1 - q->c2 * b * b));
}

NDLI_API ndli_v3 ndli_helix_point(double k, double w, double s)
{
    ndli_helix_factors q = ndli_helix_factors_of(s * s * (k * k + w * w));
    return ndli_helix_point_of(&q, k, w, s);
}

NDLI_API ndli_helix_end ndli_helix_derive(double k, double w, double s)
{
    ndli_helix_factors q = ndli_helix_factors_of(s * s * (k * k + w * w));
    ndli_helix_end e;
    double b = k * s, x = w * s;
    e.p = ndli_helix_point_of(&q, k, w, s);
    e.ds = ndli_v(-q.c1 * b * x, q.c0 * b, 1 - q.c1 * b * b);
    e.dw = ndli_scale(s * s, ndli_v(-b * (q.c2 + q.d2 * x * x), b * x * q.d1, -b * b * x * q.d2));
    return e;
}

NDLI_API ndli_pose ndli_pose_helix(const ndli_pose *pose, double k, double w, double s)
{
    ndli_helix_factors q = ndli_helix_factors_of(s * s * (k * k + w * w));
    double b = k * s, x = w * s;
    ndli_pose r;
    r.p = ndli_pose_out(pose, ndli_helix_point_of(&q, k, w, s));
    r.t = ndli_pose_along(pose, ndli_v(-q.c1 * b * x, q.c0 * b, 1 - q.c1 * b * b));
    r.m2 = ndli_pose_along(pose, ndli_v(-q.c0 * x, 1 - q.c1 * (b * b + x * x), -q.c0 * b));
    r.t = ndli_scale(1 / ndli_norm(r.t), r.t);
    r.m2 = ndli_madd(r.m2, -ndli_dot(r.m2, r.t), r.t);
    r.m2 = ndli_scale(1 / ndli_norm(r.m2), r.m2);
    r.m1 = ndli_cross(r.m2, r.t);
    return r;
}

static ndli_pose ndli_pose_raw(const ndl_tip_pose *tip)
{
    ndli_pose pose;
    pose.p = ndli_from(tip->position);
    pose.m1 = ndli_from(tip->frame.m1);
    pose.m2 = ndli_from(tip->frame.m2);
    pose.t = ndli_from(tip->frame.t);
    return pose;
}

static ndl_tip_pose ndli_pose_none(void)
{
    ndl_tip_pose none;
    memset(&none, 0, sizeof none);
    return none;
}

NDL_API ndl_tip_pose ndl_helix_pose(const ndl_tip_pose *start, sb_real curvature, sb_real twist, sb_real length)
{
    ndli_pose pose;
    if (!start)
        return ndli_pose_none();
    pose = ndli_pose_raw(start);
    pose = ndli_pose_helix(&pose, (double)curvature, (double)twist, (double)length);
    return ndli_pose_write(&pose);
}

NDL_API ndl_tip_pose ndl_tip_turn(const ndl_tip_pose *start, sb_real angle)
{
    ndli_pose pose;
    if (!start)
        return ndli_pose_none();
    pose = ndli_pose_raw(start);
    pose = ndli_pose_turn(&pose, (double)angle);
    return ndli_pose_write(&pose);
}

NDL_API sb_real ndl_helix_radius(sb_real curvature, sb_real twist)
{
    return curvature / (curvature * curvature + twist * twist);
}

NDL_API sb_real ndl_helix_pitch(sb_real curvature, sb_real twist)
{
    return (sb_real)6.283185307179586 * sb_abs(twist) / (curvature * curvature + twist * twist);
}

/* ---- bevels ---- */

static double ndli_steer_tan(double angle)
{
    double s, c;
    sbi_dense_sin_cos(angle, &s, &c);
    return s / c;
}

static sb_result ndli_bevel_check(const ndl_bevel *bevel, double d, double l)
{
    if (!bevel)
        return SB_ERROR_ARGUMENT;
    if (!sb_is_finite(bevel->angle) || !sb_is_finite(bevel->curvature) || !sb_is_finite(bevel->guide) ||
        !sb_is_finite(bevel->lag) || !ndli_is_finite(d) || !ndli_is_finite(l))
        return SB_ERROR_NOT_FINITE;
    if (!(l > 0))
        return SB_ERROR_ARGUMENT;
    if (bevel->law == NDL_BEVEL_ANGLE)
        return fabs((double)bevel->angle) < 1.5 ? SB_OK : SB_ERROR_ARGUMENT;
    if (bevel->law == NDL_BEVEL_CURVATURE)
        return d <= 0 || fabs((double)bevel->curvature) * (l + d) <= 2 ? SB_OK : SB_ERROR_ARGUMENT;
    return SB_ERROR_ARGUMENT;
}

NDL_API sb_result ndl_bevel_offset(const ndl_bevel *bevel, sb_real advance, sb_real edge_length, sb_real *offset)
{
    double d = (double)advance, l = (double)edge_length, angle;
    sb_result result = ndli_bevel_check(bevel, d, l);
    if (result != SB_OK || !offset)
        return result != SB_OK ? result : SB_ERROR_ARGUMENT;
    angle = bevel->law == NDL_BEVEL_ANGLE ? (double)bevel->angle : 0.5 * (double)bevel->curvature * (l + d);
    *offset = (sb_real)(d > 0 ? d * ndli_steer_tan(angle) : 0);
    return SB_OK;
}

NDL_API sb_result ndl_bevel_curvature(const ndl_bevel *bevel, sb_real advance, sb_real edge_length, sb_real *curvature)
{
    double d = (double)advance, l = (double)edge_length;
    sb_result result = ndli_bevel_check(bevel, d, l);
    if (result != SB_OK || !curvature || !(d >= 0))
        return result != SB_OK ? result : SB_ERROR_ARGUMENT;
    /* the angle is the one inscribed in the circle over the chord l + d, about */
    *curvature = bevel->law == NDL_BEVEL_CURVATURE ? bevel->curvature
                                                   : (sb_real)(2 * ndli_steer_tan((double)bevel->angle) / (l + d));
    return SB_OK;
}

NDL_API sb_result ndl_bevel_shift(sb_real offset, sb_vec3 m2, const sb_mat3 *deformation, sb_vec3 *shift)
{
    sb_real size = 0, det;
    sb_vec3 x;
    if (!deformation || !shift)
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < 9; i++)
        size += sb_abs(deformation->m[i / 3][i % 3]);
    if (!sb_is_finite(size) || !sb_is_finite(offset) || !sb_v3_is_finite(m2))
        return SB_ERROR_NOT_FINITE;
    det = sb_m3_det(*deformation);
    if (!(det > 0))
        return SB_ERROR_INVERTED;
    x = sb_v3_scale(offset, sb_m3_apply(sb_m3_inverse(*deformation), m2));
    if (!sb_v3_is_finite(x))
        return SB_ERROR_INVERTED;
    *shift = x;
    return SB_OK;
}

/* ---- obstacles ---- */

static double ndli_path_clamp(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

static double ndli_distance_capsule(const ndl_obstacle *o, ndli_v3 p)
{
    ndli_v3 axis = ndli_sub(ndli_from(o->b), ndli_from(o->a)), d = ndli_sub(p, ndli_from(o->a));
    double square = ndli_dot(axis, axis), at = square > 0 ? ndli_path_clamp(ndli_dot(d, axis) / square, 0, 1) : 0;
    return ndli_norm(ndli_madd(d, -at, axis)) - (double)o->radius;
}

static double ndli_distance_cylinder(const ndl_obstacle *o, ndli_v3 p)
{
    ndli_v3 axis = ndli_sub(ndli_from(o->b), ndli_from(o->a)), d = ndli_sub(p, ndli_from(o->a));
    double length = ndli_norm(axis), along = ndli_dot(d, axis) / length;
    double out = ndli_norm(ndli_madd(d, -along / length, axis)) - (double)o->radius;
    double past = fabs(along - 0.5 * length) - 0.5 * length;
    if (out > 0 && past > 0)
        return sqrt(out * out + past * past);
    return out > past ? out : past;
}

static double ndli_distance_shape(const sb_shape *shape, ndli_v3 p)
{
    if (shape->surface)
        return (double)sb_surface_signed_distance(shape->surface, ndli_to(p), NULL);
    return (double)shape->distance(shape->user, ndli_to(p)) / (double)shape->max_slope;
}

static double ndli_obstacle_distance(const ndl_obstacle *o, ndli_v3 p)
{
    if (o->kind == NDL_OBSTACLE_SPHERE)
        return ndli_norm(ndli_sub(p, ndli_from(o->a))) - (double)o->radius;
    if (o->kind == NDL_OBSTACLE_CAPSULE)
        return ndli_distance_capsule(o, p);
    if (o->kind == NDL_OBSTACLE_CYLINDER)
        return ndli_distance_cylinder(o, p);
    return o->kind == NDL_OBSTACLE_SHAPE && o->shape ? ndli_distance_shape(o->shape, p) : (double)SB_REAL_MAX;
}

NDL_API sb_real ndl_obstacle_distance(const ndl_obstacle *obstacle, sb_vec3 point)
{
    if (!obstacle)
        return SB_REAL_MAX;
    return (sb_real)ndli_obstacle_distance(obstacle, ndli_from(point));
}

NDLI_API double ndli_field_distance(const ndli_field *field, ndli_v3 p)
{
    double least = 1.7976931348623157e308;
    for (int i = 0; i < field->count; i++) {
        double d = ndli_obstacle_distance(field->obstacles + i, p);
        if (!(d >= least)) /* a distance that is no number counts as the nearest */
            least = d;
    }
    return least;
}

NDLI_API double ndli_field_march(const ndli_field *field, const ndli_pose *pose, double k, double w, double length,
                                 double slack, double *nearest)
{
    double s = 0, d;
    if (field->count == 0)
        return length;
    d = ndli_field_distance(field, pose->p);
    for (;;) {
        /* distances change by at most the way made, so half the room there is cannot be too far */
        double room = d - (field->clearance - slack * s * s * s), step, next;
        if (!(room >= 0))
            return 0;
        if (d < *nearest)
            *nearest = d;
        if (s >= length)
            return length;
        step = 0.5 * room > field->resolution ? 0.5 * room : field->resolution;
        step = s + step < length ? step : length - s;
        next = ndli_field_distance(field, ndli_pose_out(pose, ndli_helix_point(k, w, s + step)));
        if (!(next >= field->clearance - slack * (s + step) * (s + step) * (s + step)))
            return s;
        if (0.5 * (d + next - step) < *nearest)
            *nearest = 0.5 * (d + next - step);
        d = next;
        s = s + step < length ? s + step : length;
    }
}

/* ==== src/needle/steer_plan.c ==== */
/* steer_plan: the helix that ends nearest to a target, and sequences of helices past obstacles. */

static const unsigned ndli_plan_cookie = 0x706c6e31u;

/* ---- the search for one helix ----
 * f(s, w) = |p(s, w) - g| over lengths and twists. With turning the helix may be turned about the tip's axis: f is
 * then the distance in the half plane (distance from the axis, way along it), and w >= 0 is enough: -w is the mirror
 * image. p moves by at most ds/2 and slope dw/2 within a box, so f(middle) less that bounds f from below. */

enum { NDLI_SEARCH_STACK = 128, NDLI_SEARCH_STARTS = 4, NDLI_SEARCH_SEEDS = 256 };

typedef struct ndli_search {
    double k, s_max, w_low, w_high;
    ndli_v3 g;  /* target in the tip's frame */
    double rho; /* its distance from the tip's axis */
    int turn;
    double tolerance;
    int max_boxes;
    const ndli_field *field; /* or NULL: only what is clear of it counts, from this pose */
    const ndli_pose *pose;
    double s, w, distance; /* the best so far */
    double bound;
    int boxes;
} ndli_search;

typedef struct ndli_box {
    double s0, s1, w0, w1, bound;
} ndli_box;

static double ndli_search_value(const ndli_search *q, double s, double w)
{
    ndli_v3 p = ndli_helix_point(q->k, w, s);
    double r;
    if (!q->turn)
        return ndli_norm(ndli_sub(p, q->g));
    r = sqrt(p.x * p.x + p.y * p.y) - q->rho;
    return sqrt(r * r + (p.z - q->g.z) * (p.z - q->g.z));
}

static void ndli_search_keep(ndli_search *q, double s, double w, double value)
{
    if (value < q->distance) {
        q->s = s;
        q->w = w;
        q->distance = value;
    }
}

/* Takes (s, w) as the best when it is; a path that meets an obstacle is cut off before it. */
static void ndli_search_offer(ndli_search *q, double s, double w, double value)
{
    double unused = 0, free_length;
    if (!(value < q->distance))
        return;
    if (q->field) {
        free_length = ndli_field_march(q->field, q->pose, q->k, w, s, 0, &unused);
        if (free_length < s) {
            s = free_length;
            value = ndli_search_value(q, s, w);
        }
    }
    ndli_search_keep(q, s, w, value);
}

/* Residual of f at (s, w), its derivatives, and f^2. */
static double ndli_search_linear(const ndli_search *q, double s, double w, ndli_v3 *r, ndli_v3 *ds, ndli_v3 *dw)
{
    ndli_helix_end e = ndli_helix_derive(q->k, w, s);
    double out;
    *r = ndli_sub(e.p, q->g);
    *ds = e.ds;
    *dw = e.dw;
    if (q->turn) {
        out = sqrt(e.p.x * e.p.x + e.p.y * e.p.y);
        *r = ndli_v(out - q->rho, 0, e.p.z - q->g.z);
        *ds = ndli_v(out > 0 ? (e.p.x * e.ds.x + e.p.y * e.ds.y) / out : 0, 0, e.ds.z);
        *dw = ndli_v(out > 0 ? (e.p.x * e.dw.x + e.p.y * e.dw.y) / out : 0, 0, e.dw.z);
    }
    return ndli_dot(*r, *r);
}

static int ndli_search_leaves(double x, double low, double high, double gradient)
{
    return (x <= low && gradient > 0) || (x >= high && gradient < 0);
}

static double ndli_search_into(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

/* Levenberg-Marquardt within the limits, from (*s, *w); a variable at a limit that the descent would leave stays. */
static void ndli_search_descend(const ndli_search *q, double *s, double *w)
{
    ndli_v3 r, ds, dw;
    double damping = 1e-3, enough = q->tolerance / 64 * (q->tolerance / 64);
    double now = ndli_search_linear(q, *s, *w, &r, &ds, &dw);
    for (int i = 0; i < 24 && now > enough && damping < 1e8; i++) {
        double gs = ndli_dot(r, ds), gw = ndli_dot(r, dw), a = ndli_dot(ds, ds), b = ndli_dot(ds, dw),
               c = ndli_dot(dw, dw), det, try_s, try_w, value;
        if (ndli_search_leaves(*s, 0, q->s_max, gs))
            gs = 0, a = 1, b = 0;
        if (!(c > 0) || ndli_search_leaves(*w, q->w_low, q->w_high, gw))
            gw = 0, c = 1, b = 0;
        a *= 1 + damping;
        c *= 1 + damping;
        det = a * c - b * b;
        try_s = ndli_search_into(*s - (c * gs - b * gw) / det, 0, q->s_max);
        try_w = ndli_search_into(*w - (a * gw - b * gs) / det, q->w_low, q->w_high);
        value = ndli_search_value(q, try_s, try_w);
        if (value * value < now) {
            double gain = now - value * value;
            *s = try_s;
            *w = try_w;
            now = ndli_search_linear(q, *s, *w, &r, &ds, &dw);
            damping *= 0.1;
            if (gain < 1e-6 * now)
                break;
        } else {
            damping *= 10;
        }
    }
}

/* Descends from the best of a row of twists, about four to each turn of the helix (f changes as fast as that), all at
 * the length of the chord. */
static void ndli_search_start(ndli_search *q)
{
    double at[NDLI_SEARCH_STARTS], value[NDLI_SEARCH_STARTS], range = q->w_high - q->w_low;
    double chord = ndli_norm(q->g), s = chord < q->s_max ? chord : q->s_max, turns = range * s * (2 / 3.14159265358979);
    int seeds = turns < NDLI_SEARCH_SEEDS - 4 ? (int)turns + 4 : NDLI_SEARCH_SEEDS, count = 0;
    for (int i = 0; i < seeds; i++) {
        double w = q->w_low + range * i / (seeds - 1), f = ndli_search_value(q, s, w);
        int k = count < NDLI_SEARCH_STARTS ? count++ : NDLI_SEARCH_STARTS;
        for (; k > 0 && f < value[k - 1]; k--)
            if (k < NDLI_SEARCH_STARTS)
                value[k] = value[k - 1], at[k] = at[k - 1];
        if (k < NDLI_SEARCH_STARTS)
            value[k] = f, at[k] = w;
    }
    for (int i = 0; i < count && q->distance > q->tolerance; i++) {
        double length = s, w = at[i];
        ndli_search_descend(q, &length, &w);
        ndli_search_offer(q, length, w, ndli_search_value(q, length, w));
    }
}

/* Upper bound of |dp/dw| over a box: k s^3/6, and for tight helices k s/W^2 |(2 + 2/a, 1 + 4/a, (3 + 3/a) k/W)| with
 * W^2 = k^2 + w^2, a = s W. The first is the limit of small k s, measured to hold everywhere (0.99991 of it at most);
 * the second follows from 0 <= c2 <= (1 + 1/a)/a^2, |c1'| <= (1 + 4/a)/a^2, |c2'| <= 3 (1 + 1/a)/a^3. */
static double ndli_search_slope(const ndli_search *q, const ndli_box *b)
{
    double w = b->w0 > 0 ? b->w0 : b->w1 < 0 ? b->w1 : 0, square = q->k * q->k + w * w, rate = sqrt(square);
    double slope = q->k * b->s1 * b->s1 * b->s1 / 6, a = b->s0 * rate, x, y, z, tail;
    if (!(a > 1))
        return slope;
    x = 2 + 2 / a;
    y = 1 + 4 / a;
    z = (3 + 3 / a) * q->k / rate;
    tail = q->k * b->s1 / square * sqrt(x * x + y * y + z * z);
    return tail < slope ? tail : slope;
}

/* Looks at a box: offers its middle, sets its bound; `longer`: whether it is to be split along s. */
static void ndli_search_look(ndli_search *q, ndli_box *b, int *longer)
{
    double s = 0.5 * (b->s0 + b->s1), w = 0.5 * (b->w0 + b->w1), value = ndli_search_value(q, s, w);
    double along = 0.5 * (b->s1 - b->s0), across = 0.5 * (b->w1 - b->w0) * ndli_search_slope(q, b), least;
    q->boxes++;
    *longer = along > across;
    least = value - along - across;
    b->bound = b->bound > least ? b->bound : least;
    if (q->field && value < q->distance && b->bound < q->distance - q->tolerance) {
        /* all paths of the box are within slack s^3 of its middle one */
        double unused = 0, slack = 0.5 * (b->w1 - b->w0) * q->k / 6;
        if (ndli_field_march(q->field, q->pose, q->k, w, b->s0, slack, &unused) < b->s0)
            b->bound = q->distance; /* all are blocked before they get there */
    }
    ndli_search_offer(q, s, w, value);
}

static void ndli_search_branch(ndli_search *q)
{
    ndli_box stack[NDLI_SEARCH_STACK];
    int split[NDLI_SEARCH_STACK], top = 1;
    memset(stack, 0, sizeof stack[0]);
    stack[0].s1 = q->s_max;
    stack[0].w0 = q->w_low;
    stack[0].w1 = q->w_high;
    ndli_search_look(q, stack, split);
    q->bound = q->distance;
    while (top > 0) {
        ndli_box b = stack[--top], half[2];
        int longer[2], first;
        if (b.bound >= q->distance - q->tolerance || q->boxes >= q->max_boxes || top + 2 > NDLI_SEARCH_STACK) {
            q->bound = b.bound < q->bound ? b.bound : q->bound;
            continue;
        }
        half[0] = half[1] = b;
        if (split[top])
            half[0].s1 = half[1].s0 = 0.5 * (b.s0 + b.s1);
        else
            half[0].w1 = half[1].w0 = 0.5 * (b.w0 + b.w1);
        ndli_search_look(q, half, longer);
        ndli_search_look(q, half + 1, longer + 1);
        first = half[1].bound < half[0].bound; /* the more promising half is taken next */
        stack[top] = half[!first];
        split[top++] = longer[!first];
        stack[top] = half[first];
        split[top++] = longer[first];
    }
    q->bound = q->bound < q->distance ? q->bound : q->distance;
}

static void ndli_search_run(ndli_search *q)
{
    q->boxes = 0;
    q->s = 0;
    q->w = 0;
    q->distance = ndli_norm(q->g);
    q->bound = 0;
    if (q->distance > q->tolerance)
        ndli_search_start(q);
    if (q->distance > q->tolerance)
        ndli_search_branch(q);
}

static ndli_search ndli_search_of(const ndl_plan_def *def, const ndli_pose *pose, ndli_v3 target, double max_length)
{
    ndli_search q;
    memset(&q, 0, sizeof q);
    q.k = (double)def->curvature;
    q.s_max = max_length;
    q.w_high = (double)def->max_twist;
    q.w_low = def->turn ? 0 : -q.w_high;
    q.g = ndli_pose_in(pose, target);
    q.rho = sqrt(q.g.x * q.g.x + q.g.y * q.g.y);
    q.turn = def->turn;
    q.tolerance = (double)def->tolerance;
    q.max_boxes = def->max_boxes;
    q.pose = pose;
    return q;
}

static double ndli_plan_wrap(double angle)
{
    const double pi = 3.141592653589793;
    return angle > pi ? angle - 2 * pi : angle < -pi ? angle + 2 * pi : angle;
}

/* The piece that a search found. With turning both w and -w do; the smaller turn is taken, unless it is no more than a
 * little smaller and against `sense`: a choice that flips with the noise of sensing would never be carried out. */
static ndl_plan_piece ndli_search_piece(const ndli_search *q, double sense)
{
    const double little = 0.5;
    ndl_plan_piece piece;
    double turn = 0, w = q->w;
    if (q->turn && q->rho > 0 && q->s > 0) {
        ndli_v3 p = ndli_helix_point(q->k, w, q->s);
        double azimuth = sbi_dense_atan2(q->g.y, q->g.x);
        double one = ndli_plan_wrap(azimuth - sbi_dense_atan2(p.y, p.x));
        double two = ndli_plan_wrap(azimuth - sbi_dense_atan2(p.y, -p.x));
        int mirrored = fabs(two) + (sense > 0 ? little : sense < 0 ? -little : 0) < fabs(one);
        turn = mirrored ? two : one;
        w = mirrored ? -w : w;
    }
    piece.turn = (sb_real)turn;
    piece.twist = (sb_real)w;
    piece.length = (sb_real)q->s;
    return piece;
}

/* ---- plans ---- */

static void ndli_plan_clear(ndl_plan *plan)
{
    memset(plan, 0, sizeof *plan);
    plan->outcome = NDL_PLAN_SHORT;
    plan->clearance = SB_REAL_MAX;
}

static ndli_pose ndli_plan_follow(const ndli_pose *pose, double k, const ndl_plan_piece *piece, double length)
{
    ndli_pose r = ndli_pose_turn(pose, (double)piece->turn);
    return ndli_pose_helix(&r, k, (double)piece->twist, length);
}

/* Appends a piece as far as it is clear; returns whether all of it is. *pose moves to its end. */
static int ndli_plan_append(const ndl_plan_def *def, const ndli_field *field, const ndl_plan_piece *piece,
                            ndli_pose *pose, ndl_plan *plan)
{
    double k = (double)def->curvature, wanted = (double)piece->length, nearest = (double)plan->clearance, length;
    ndli_pose from = ndli_pose_turn(pose, (double)piece->turn);
    ndl_plan_piece *to = plan->pieces + plan->piece_count++;
    length = ndli_field_march(field, &from, k, (double)piece->twist, wanted, 0, &nearest);
    *to = *piece;
    if (length < wanted)
        to->length = (sb_real)length;
    plan->length += to->length;
    plan->clearance = (sb_real)nearest;
    *pose = ndli_pose_helix(&from, k, (double)piece->twist, length);
    return length >= wanted;
}

static void ndli_plan_finish(const ndl_plan_def *def, const ndli_pose *end, ndli_v3 target, ndl_plan *plan)
{
    plan->distance = (sb_real)ndli_norm(ndli_sub(end->p, target));
    plan->outcome = plan->distance <= def->tolerance ? NDL_PLAN_REACHES : NDL_PLAN_SHORT;
}

/* Obstacles at `clearance`, or at nine tenths of the tip's distance where that is less. */
static ndli_field ndli_plan_field(const ndl_plan_def *def, double clearance, const ndli_pose *pose)
{
    ndli_field field;
    double room;
    field.obstacles = def->obstacles;
    field.count = def->obstacle_count;
    field.clearance = clearance;
    field.resolution = (double)def->tolerance;
    room = 0.9 * ndli_field_distance(&field, pose->p);
    if (room < clearance)
        field.clearance = room;
    return field;
}

NDLI_API int ndli_plan_aim(const ndl_plan_def *def, double clearance, const ndli_pose *pose, const sb_vec3 *waypoints,
                           int waypoint_count, ndli_v3 target, double sense, ndl_plan *plan)
{
    ndli_field field = ndli_plan_field(def, clearance, pose);
    ndli_pose at = *pose;
    int clear = !(field.clearance < 0);
    ndli_plan_clear(plan);
    for (int i = 0; i <= waypoint_count && clear; i++) {
        ndli_v3 goal = i < waypoint_count ? ndli_from(waypoints[i]) : target;
        ndli_search q = ndli_search_of(def, &at, goal, (double)def->max_length - (double)plan->length);
        ndl_plan_piece piece;
        ndli_search_run(&q);
        piece = ndli_search_piece(&q, i == 0 ? sense : 0);
        plan->boxes += q.boxes;
        if (waypoint_count == 0)
            plan->bound = (sb_real)q.bound;
        clear = ndli_plan_append(def, &field, &piece, &at, plan);
    }
    ndli_plan_finish(def, &at, target, plan);
    if (field.clearance < 0)
        plan->outcome = NDL_PLAN_BLOCKED;
    return clear;
}

/* ---- sequences past obstacles ---- */

/* A sequence is its pieces but the last, which aims: for each three numbers in [0, 1], of turn, twist and length. */
enum { NDLI_ROUTE_NUMBERS = 3 * (NDL_PLAN_PIECES - 1) };

typedef struct ndli_route {
    double number[NDLI_ROUTE_NUMBERS];
    double cost;
    ndl_plan plan;
} ndli_route;

typedef struct ndli_router {
    const ndl_plan_def *def; /* with few boxes for each aim */
    ndli_field field;
    ndli_pose pose;
    ndli_v3 target;
    double reach; /* m: pieces before the last are shorter than this in all */
    int pieces;
} ndli_router;

/* Three tenths of the twists tried are 0: arcs, which turn the needle most. The rest grows as a square: a helix gets
 * straighter fast. */
static double ndli_route_twist(double number, double most)
{
    double x = 2 * number - 1, size = fabs(x) < 0.3 ? 0 : (fabs(x) - 0.3) / 0.7;
    return (x < 0 ? -1 : 1) * most * size * size;
}

static int ndli_route_better(const ndli_route *a, const ndli_route *b)
{
    int reaches_a = a->plan.outcome == NDL_PLAN_REACHES, reaches_b = b->plan.outcome == NDL_PLAN_REACHES;
    if (reaches_a != reaches_b)
        return reaches_a;
    return reaches_a ? a->cost < b->cost : a->plan.distance < b->plan.distance;
}

/* Cost (m) of a path that reaches: its length, what lacks to twice the clearance, and what lacks to a margin by which
 * the last piece could still be bent (a needle that bends less than planned would miss). */
static double ndli_route_cost(const ndli_router *router, const ndl_plan *plan, ndli_v3 last)
{
    double radius = 1 / (double)router->def->curvature, cost = (double)plan->length;
    double room = 2 * router->field.clearance - (double)plan->clearance;
    double out = sqrt(last.x * last.x + last.y * last.y) - radius;
    double margin = 0.05 * radius - (sqrt(out * out + last.z * last.z) - radius);
    return cost + (room > 0 ? 4 * room : 0) + (margin > 0 ? 4 * margin : 0);
}

static void ndli_route_try(const ndli_router *router, ndli_route *route)
{
    const ndl_plan_def *def = router->def;
    ndl_plan *plan = &route->plan;
    ndli_pose at = router->pose;
    ndli_v3 last = ndli_v(0, 0, 0);
    int clear = 1;
    ndli_plan_clear(plan);
    for (int i = 0; i < router->pieces && clear; i++) {
        double left = (double)def->max_length - (double)plan->length;
        ndl_plan_piece piece;
        if (i + 1 < router->pieces) {
            const double *x = route->number + 3 * i;
            double length = x[2] * router->reach / (router->pieces - 1);
            piece.turn = (sb_real)(def->turn ? 6.283185307179586 * (x[0] - 0.5) : 0);
            piece.twist = (sb_real)ndli_route_twist(x[1], (double)def->max_twist);
            piece.length = (sb_real)(length < left ? length : left);
        } else {
            ndli_search q = ndli_search_of(def, &at, router->target, left);
            ndli_search_run(&q);
            piece = ndli_search_piece(&q, 0);
            plan->boxes += q.boxes;
            last = q.g;
        }
        clear = ndli_plan_append(def, &router->field, &piece, &at, plan);
    }
    ndli_plan_finish(def, &at, router->target, plan);
    route->cost = ndli_route_cost(router, plan, last);
}

static void ndli_route_consider(const ndli_router *router, ndli_route *route, ndli_route *best, int *boxes)
{
    ndli_route_try(router, route);
    *boxes += route->plan.boxes;
    if (ndli_route_better(route, best))
        *best = *route;
}

/* Points of a Kronecker sequence: they fill the unit cube evenly, in any number of dimensions, with no random numbers.
 * */
static void ndli_route_sample(const ndli_router *router, ndli_route *best, int *boxes)
{
    double golden = router->pieces == 2 ? 1.2207440846057596 : 1.1127756842787055; /* x^(n + 1) = x + 1 */
    for (int i = 1; i <= router->def->samples; i++) {
        ndli_route route;
        double alpha = 1;
        memset(&route, 0, sizeof route);
        for (int j = 0; j < 3 * (router->pieces - 1); j++) {
            double x;
            alpha /= golden;
            x = 0.5 + alpha * i;
            route.number[j] = x - (int)x;
        }
        ndli_route_consider(router, &route, best, boxes);
    }
}

/* Goes to better neighbours, along one number at a time, in ever smaller steps. */
static void ndli_route_improve(const ndli_router *router, ndli_route *best, int *boxes)
{
    double step = 0.08;
    for (int round = 0; round < 6; round++, step *= 0.5)
        for (int j = 0; j < 3 * (router->pieces - 1); j++)
            for (int side = -1; side <= 1; side += 2) {
                ndli_route route = *best;
                double x = route.number[j] + side * step;
                route.number[j] = j % 3 == 0 ? x - (x >= 1) + (x < 0) : ndli_search_into(x, 0, 1);
                ndli_route_consider(router, &route, best, boxes);
            }
}

/* Better plans than *plan of two and, if need be, more pieces. */
static void ndli_plan_route(const ndl_plan_def *def, const ndli_field *field, const ndli_pose *pose, ndli_v3 target,
                            ndl_plan *plan)
{
    ndl_plan_def quick = *def;
    ndli_router router;
    ndli_route best;
    double most = (double)def->max_length, chord = ndli_norm(ndli_sub(target, pose->p));
    int boxes = plan->boxes;
    quick.max_boxes = def->max_boxes < 40 ? def->max_boxes : 40; /* for its rank among others a rough end will do */
    router.def = &quick;
    router.field = *field;
    router.pose = *pose;
    router.target = target;
    router.reach = chord < most ? chord : most;
    memset(&best, 0, sizeof best);
    best.plan = *plan;
    for (int n = 2; n <= def->max_pieces && best.plan.outcome != NDL_PLAN_REACHES; n++) {
        ndli_route found = best; /* its numbers mean something for n pieces only */
        router.pieces = n;
        ndli_route_sample(&router, &found, &boxes);
        if (found.plan.piece_count == n)
            ndli_route_improve(&router, &found, &boxes);
        best = found;
    }
    best.plan.boxes = boxes;
    best.plan.bound = plan->bound;
    *plan = best.plan;
}

/* One steady twist past obstacles, without turning. */
static void ndli_plan_thread(const ndl_plan_def *def, const ndli_field *field, const ndli_pose *pose, ndli_v3 target,
                             ndl_plan *plan)
{
    ndli_search q = ndli_search_of(def, pose, target, (double)def->max_length);
    ndl_plan found;
    ndl_plan_piece piece;
    ndli_pose at = *pose;
    q.field = field;
    ndli_search_run(&q);
    piece = ndli_search_piece(&q, 0);
    ndli_plan_clear(&found);
    ndli_plan_append(def, field, &piece, &at, &found);
    ndli_plan_finish(def, &at, target, &found);
    found.boxes = plan->boxes + q.boxes;
    found.bound = plan->bound;
    if (found.distance < plan->distance)
        *plan = found;
    else
        plan->boxes = found.boxes;
}

NDLI_API void ndli_plan_search(const ndl_plan_def *def, const ndli_pose *pose, ndli_v3 target, double sense,
                               ndl_plan *plan)
{
    ndli_field field = ndli_plan_field(def, (double)def->clearance, pose);
    if (ndli_plan_aim(def, (double)def->clearance, pose, NULL, 0, target, sense, plan) ||
        plan->outcome == NDL_PLAN_BLOCKED)
        return;
    if (!def->turn)
        ndli_plan_thread(def, &field, pose, target, plan);
    if (plan->outcome != NDL_PLAN_REACHES)
        ndli_plan_route(def, &field, pose, target, plan);
}

/* ---- the public side ---- */

NDL_API ndl_plan_def ndl_default_plan_def(sb_real curvature, sb_real max_length)
{
    ndl_plan_def def;
    memset(&def, 0, sizeof def);
    def.curvature = curvature;
    def.max_length = max_length;
    def.max_twist = 50 * curvature;
    def.turn = 1;
    def.tolerance = (sb_real)1e-3 / curvature;
    def.max_boxes = 5000;
    def.clearance = (sb_real)5e-3 / curvature;
    def.max_pieces = NDL_PLAN_PIECES;
    def.samples = 400;
    def.cookie = ndli_plan_cookie;
    return def;
}

static int ndli_plan_positive(sb_real x) { return x > 0 && x <= SB_REAL_MAX; }
static int ndli_plan_not_negative(sb_real x) { return x >= 0 && x <= SB_REAL_MAX; }

NDLI_API sb_result ndli_obstacle_check(const ndl_obstacle *o, int i, sb_error *error)
{
    if (o->kind < NDL_OBSTACLE_SPHERE || o->kind > NDL_OBSTACLE_SHAPE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "obstacle %d is of no such kind", i);
    if (o->kind == NDL_OBSTACLE_SHAPE) {
        if (!o->shape || (!o->shape->surface && !o->shape->distance))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "obstacle %d has no shape", i);
        if (!o->shape->surface && !ndli_plan_positive(o->shape->max_slope))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "obstacle %d: the function needs a max_slope above 0", i);
        return SB_OK;
    }
    if (!sb_v3_is_finite(o->a) || (o->kind != NDL_OBSTACLE_SPHERE && !sb_v3_is_finite(o->b)))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "obstacle %d is not finite", i);
    if (!ndli_plan_positive(o->radius))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "obstacle %d: radius must be finite and above 0", i);
    if (o->kind == NDL_OBSTACLE_CYLINDER && !(ndli_norm(ndli_sub(ndli_from(o->b), ndli_from(o->a))) > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "obstacle %d: the ends of the cylinder coincide", i);
    return SB_OK;
}

NDLI_API sb_result ndli_plan_check(const ndl_plan_def *def, sb_error *error)
{
    if (def->cookie != ndli_plan_cookie)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the plan def does not come from ndl_default_plan_def()");
    if (!ndli_plan_positive(def->curvature) || !ndli_plan_positive(def->max_length))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "curvature and max_length must be finite and above 0");
    if (!ndli_plan_not_negative(def->max_twist) || !ndli_plan_not_negative(def->clearance))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_twist and clearance must be finite and not negative");
    if (!(def->tolerance >= (sb_real)1e-6 * def->max_length) || !(def->tolerance <= def->max_length))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "tolerance must be between 1e-6 of max_length and max_length");
    if (def->turn != 0 && def->turn != 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "turn must be 0 or 1");
    if (def->max_boxes < 1 || def->samples < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_boxes and samples must be at least 1");
    if (def->max_pieces < 1 || def->max_pieces > NDL_PLAN_PIECES)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_pieces must be between 1 and %d", NDL_PLAN_PIECES);
    if (def->obstacle_count < 0 || (def->obstacle_count > 0 && !def->obstacles))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "obstacle_count is negative, or there are no obstacles to count");
    for (int i = 0; i < def->obstacle_count; i++) {
        sb_result result = ndli_obstacle_check(def->obstacles + i, i, error);
        if (result != SB_OK)
            return result;
    }
    return SB_OK;
}

NDL_API sb_result ndl_plan_make(const ndl_plan_def *def, const ndl_tip_pose *tip, sb_vec3 target, ndl_plan *plan,
                                sb_error *error)
{
    ndli_pose pose;
    sb_result result;
    if (!def || !tip || !plan)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def, tip or plan is NULL");
    result = ndli_plan_check(def, error);
    if (result != SB_OK)
        return result;
    result = ndli_pose_read(tip, &pose);
    if (result != SB_OK)
        return sbi_fail(error, result,
                        result == SB_ERROR_NOT_FINITE ? "the tip is not finite" : "the tip's frame is not orthonormal");
    if (!sb_v3_is_finite(target))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the target is not finite");
    ndli_plan_search(def, &pose, ndli_from(target), 0, plan);
    return SB_OK;
}

NDL_API ndl_tip_pose ndl_plan_pose(const ndl_plan *plan, sb_real curvature, const ndl_tip_pose *tip, sb_real length)
{
    ndl_tip_pose none;
    ndli_pose pose;
    double left = (double)length;
    if (!plan || !tip) {
        memset(&none, 0, sizeof none);
        return none;
    }
    pose.p = ndli_from(tip->position);
    pose.m1 = ndli_from(tip->frame.m1);
    pose.m2 = ndli_from(tip->frame.m2);
    pose.t = ndli_from(tip->frame.t);
    for (int i = 0; i < plan->piece_count && (i == 0 || left > 0); i++) {
        double whole = (double)plan->pieces[i].length;
        pose = ndli_plan_follow(&pose, (double)curvature, plan->pieces + i, ndli_search_into(left, 0, whole));
        left -= whole;
    }
    return ndli_pose_write(&pose);
}

/* ==== src/needle/steer.c ==== */
/* steer: the controller that replans at every step and follows its plan past obstacles. */

static const unsigned ndli_steer_cookie = 0x73747231u;

NDL_API ndl_steer_def ndl_default_steer_def(sb_real curvature, sb_real max_length)
{
    ndl_steer_def def;
    memset(&def, 0, sizeof def);
    def.plan = ndl_default_plan_def(curvature, max_length);
    def.reserve = (sb_real)0.2;
    def.step = (sb_real)0.01 / curvature;
    def.max_turn = 1;
    def.turn_gain = (sb_real)0.5;
    def.turn_first = (sb_real)0.3;
    def.max_wait = 40;
    def.reach = (sb_real)0.01 / curvature;
    def.max_updates = 10000;
    def.learn = (sb_real)0.12 / curvature;
    def.cookie = ndli_steer_cookie;
    return def;
}

static int ndli_steer_positive(sb_real x) { return x > 0 && x <= SB_REAL_MAX; }

NDL_API sb_result ndl_steer_begin(const ndl_steer_def *def, ndl_steer *steer, sb_error *error)
{
    sb_result result;
    if (!def || !steer)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def or steer is NULL");
    if (def->cookie != ndli_steer_cookie)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def does not come from ndl_default_steer_def()");
    result = ndli_plan_check(&def->plan, error);
    if (result != SB_OK)
        return result;
    if (!ndli_steer_positive(def->step) || !ndli_steer_positive(def->max_turn) || !ndli_steer_positive(def->reach))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "step, max_turn and reach must be finite and above 0");
    if (!(def->turn_gain > 0) || !(def->turn_gain <= 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "turn_gain must be above 0 and at most 1");
    if (!(def->turn_first >= 0) || def->max_wait < 0 || def->max_updates < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "turn_first and max_wait must not be negative, max_updates at least 1");
    if (!(def->reserve >= 0) || !(def->reserve < 1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "reserve must be at least 0 and below 1");
    if (!(def->learn >= 0) || !(def->learn <= sb_sqrt(SB_REAL_MAX) / 8)) /* sums hold its square */
        return sbi_fail(error, SB_ERROR_ARGUMENT, "learn must not be negative, and its square finite");
    memset(steer, 0, sizeof *steer);
    steer->def = *def;
    steer->plan.outcome = NDL_PLAN_SHORT;
    steer->curvature = def->plan.curvature;
    return SB_OK;
}

/* ---- what is learned ----
 * Between two sensed tips the needle was inserted by ds. Across their mean heading the tip has moved by ds times the
 * drift; heading and drift are its way, which has turned along m2 by ds times the curvature. The drift is averaged with
 * the weight ds/(ds + learn); the curvature is a least-squares fit that forgets. What it begins with is forgotten five
 * times as fast as what is measured. It never goes beyond that: to count on more bend than there is ends beside the
 * target, to count on less costs a longer way. */

static const double ndli_steer_memory = 2; /* of the curvature, in lengths of def.learn: noise has more effect on it */
static const double ndli_steer_seen_bend = 0.05; /* rad: more than noise, and less than 1 cm of most needles */
static const double ndli_steer_most_drift = 0.3;

static void ndli_steer_learn_drift(ndl_steer *steer, const ndli_pose *pose, double ds)
{
    double share = ds / (ds + (double)steer->def.learn), size;
    ndli_v3 ahead = ndli_add(pose->t, ndli_from(steer->tip.frame.t)), lean;
    ndli_v3 moved = ndli_sub(pose->p, ndli_from(steer->tip.position));
    ahead = ndli_scale(1 / ndli_norm(ahead), ahead);
    lean = ndli_scale(1 / ds, ndli_madd(moved, -ndli_dot(moved, ahead), ahead));
    size = ndli_norm(lean);
    if (size > ndli_steer_most_drift)
        lean = ndli_scale(ndli_steer_most_drift / size, lean);
    steer->drift = ndli_to(ndli_madd(ndli_scale(1 - share, ndli_from(steer->drift)), share, lean));
}

static void ndli_steer_learn_curvature(ndl_steer *steer, ndli_v3 turned, ndli_v3 m2, double ds)
{
    double given = (double)steer->def.plan.curvature, memory = ndli_steer_memory * (double)steer->def.learn;
    double way = ds * ndli_norm(m2), k = (double)steer->curvature; /* shorter where the tip was rolled between them */
    double weight = steer->weight > 0 ? (double)steer->weight : 0.2 * memory * (double)steer->def.step;
    if (!(way > 0.5 * ds))
        return;
    weight = weight * memory / (memory + ds) + way * way;
    k += way * (ndli_dot(turned, m2) / ndli_norm(m2) - k * way) / weight;
    steer->curvature = (sb_real)(k < 0.5 * given ? 0.5 * given : k > given ? given : k);
    steer->weight = (sb_real)weight;
}

/* The sensed pose, made to look along the tip's way. */
static ndli_pose ndli_steer_on_way(const ndl_steer *steer, const ndli_pose *pose)
{
    ndli_pose on = *pose;
    ndli_v3 t = ndli_add(pose->t, ndli_from(steer->drift));
    on.t = ndli_scale(1 / ndli_norm(t), t);
    on.m2 = ndli_madd(pose->m2, -ndli_dot(pose->m2, on.t), on.t);
    on.m2 = ndli_scale(1 / ndli_norm(on.m2), on.m2);
    on.m1 = ndli_cross(on.m2, on.t);
    return on;
}

/* From another sensed pose; makes it one that looks along the tip's way. */
static void ndli_steer_learn(ndl_steer *steer, ndli_pose *pose)
{
    double ds = (double)steer->advance;
    int moved = steer->updates > 0 && steer->def.learn > 0 && ds > 0.25 * (double)steer->def.step &&
                ndli_dot(pose->t, ndli_from(steer->tip.frame.t)) > 0;
    ndl_tip_pose sensed = ndli_pose_write(pose);
    if (steer->updates == 0)
        steer->first = sensed.frame.t;
    if (moved)
        ndli_steer_learn_drift(steer, pose, ds);
    *pose = ndli_steer_on_way(steer, pose);
    if (moved && steer->bends)
        ndli_steer_learn_curvature(steer, ndli_sub(pose->t, ndli_from(steer->way)),
                                   ndli_scale(0.5, ndli_add(pose->m2, ndli_from(steer->tip.frame.m2))), ds);
    if (moved && !steer->bends)
        steer->bends = ndli_norm(ndli_sub(pose->t, ndli_from(steer->first))) > ndli_steer_seen_bend;
    steer->tip = sensed;
    steer->way = ndli_to(pose->t);
}

/* ---- the plan ---- */

/* Remembers where the pieces of the plan before its last one end. */
static void ndli_steer_mark(ndl_steer *steer, const ndl_plan_def *def, const ndli_pose *pose)
{
    ndl_tip_pose tip = ndli_pose_write(pose);
    sb_real length = 0;
    steer->waypoint_count = 0;
    for (int i = 0; i + 1 < steer->plan.piece_count; i++) {
        length += steer->plan.pieces[i].length;
        steer->waypoints[i] = ndl_plan_pose(&steer->plan, def->curvature, &tip, length).position;
        steer->waypoint_count++;
    }
}

static void ndli_steer_drop_waypoint(ndl_steer *steer)
{
    for (int i = 1; i < steer->waypoint_count; i++)
        steer->waypoints[i - 1] = steer->waypoints[i];
    steer->waypoint_count--;
}

/* Searches the way anew, at half the clearance where the whole one leaves none that gets there. */
static void ndli_steer_search(ndl_steer *steer, const ndl_plan_def *def, const ndli_pose *pose, ndli_v3 target,
                              double sense, ndl_plan *plan)
{
    ndl_plan_def close = *def;
    ndl_plan other;
    close.clearance = (sb_real)0.5 * def->clearance;
    steer->plans++;
    ndli_plan_search(def, pose, target, sense, plan);
    if (plan->outcome != NDL_PLAN_SHORT)
        return;
    ndli_plan_search(&close, pose, target, sense, &other);
    if (other.distance < plan->distance - def->tolerance)
        *plan = other;
}

/* Leaves out first pieces with no length to speak of: with nothing to insert the needle would wait at them for ever. */
static void ndli_steer_skip_empty(ndl_plan *plan, sb_real least)
{
    while (plan->piece_count > 1 && plan->pieces[0].length < least) {
        sb_real turn = plan->pieces[0].turn + plan->pieces[1].turn;
        plan->length -= plan->pieces[0].length;
        plan->piece_count--;
        memmove(plan->pieces, plan->pieces + 1, (size_t)plan->piece_count * sizeof plan->pieces[0]);
        plan->pieces[0].turn = turn > (sb_real)3.14159265358979    ? turn - (sb_real)6.28318530717959
                               : turn < -(sb_real)3.14159265358979 ? turn + (sb_real)6.28318530717959
                                                                   : turn;
    }
}

/* steer->plan from the sensed pose: the present one aimed anew, unless obstacles ask for another one. A way that is
 * clear but does not get there gives place only to one that is better by far: changing from one to another and back, a
 * needle would turn and never go on. */
static void ndli_steer_plan(ndl_steer *steer, const ndli_pose *pose, ndli_v3 target)
{
    ndl_plan_def def = steer->def.plan;
    ndl_plan plan, other;
    double sense = steer->plan.piece_count > 0 ? (double)steer->plan.pieces[0].twist : 0;
    sb_real enough = (sb_real)0.5 * steer->def.reach;
    const int between = 8; /* updates, while there is no hurry */
    int clear;
    def.curvature = steer->curvature * (1 - steer->def.reserve);
    def.max_length = def.max_length > steer->inserted ? def.max_length - steer->inserted : 0;
    for (;;) { /* waypoints that the tip has come to, or can get no nearer to, are done with */
        clear = ndli_plan_aim(&def, 0.5 * (double)def.clearance, pose, steer->waypoints, steer->waypoint_count, target,
                              sense, &plan);
        if (steer->waypoint_count == 0 || !(plan.pieces[0].length < (sb_real)0.5 * steer->def.step))
            break;
        ndli_steer_drop_waypoint(steer);
    }
    if (def.obstacle_count > 0 && (!clear || (plan.distance > enough && steer->updates >= steer->next_search))) {
        steer->next_search = steer->updates + between;
        ndli_steer_search(steer, &def, pose, target, sense, &other);
        if (!clear || other.distance < plan.distance - enough)
            plan = other;
    }
    ndli_steer_skip_empty(&plan, (sb_real)0.25 * steer->def.step);
    steer->plan = plan;
    ndli_steer_mark(steer, &def, pose);
}

/* ---- the command ---- */

static ndl_steer_status ndli_steer_end(const ndl_steer *steer, double distance)
{
    int obstacles = steer->def.plan.obstacle_count > 0;
    sb_real little = 2 * steer->def.plan.tolerance;
    if (distance <= (double)steer->def.reach)
        return NDL_STEER_REACHED;
    if (steer->inserted + (sb_real)0.25 * steer->def.step >= steer->def.plan.max_length)
        return NDL_STEER_LIMIT;
    if (steer->plan.outcome == NDL_PLAN_BLOCKED || (obstacles && steer->plan.distance > steer->plan.bound + little))
        return NDL_STEER_BLOCKED; /* without obstacles there would be a way to get nearer */
    return NDL_STEER_CLOSEST;
}

/* How much of the roll that the plan asks for is worth turning for: little where the point aimed at lies ahead (its
 * azimuth is noise), none where what is left to insert can no longer bend the path by the tolerance. */
static double ndli_steer_worth(const ndl_steer *steer, double aside)
{
    double tolerance = (double)steer->def.plan.tolerance, length = (double)steer->plan.length;
    double bend = 0.5 * (double)steer->def.plan.curvature * length * length;
    if (bend < tolerance)
        return 0;
    return aside < 2 * tolerance ? aside / (2 * tolerance) : 1;
}

static void ndli_steer_move(ndl_steer *steer, const ndli_pose *pose, ndli_v3 target, ndl_steer_command *command)
{
    const ndl_steer_def *def = &steer->def;
    const ndl_plan_piece *piece = steer->plan.pieces;
    ndli_v3 g = ndli_pose_in(pose, steer->waypoint_count > 0 ? ndli_from(steer->waypoints[0]) : target);
    double aside = sqrt(g.x * g.x + g.y * g.y), worth = ndli_steer_worth(steer, aside), most = (double)def->max_turn;
    double turn = worth * (double)piece->turn, insertion = (double)sb_min(piece->length, def->step);
    if (fabs(turn) > (double)def->turn_first && steer->waited < def->max_wait) {
        steer->waited++;
        insertion = 0;
    } else {
        steer->waited = 0;
    }
    turn = (double)def->turn_gain * turn + (worth > 0 ? (double)piece->twist * insertion : 0);
    command->turn = (sb_real)(turn > most ? most : turn < -most ? -most : turn);
    command->insertion = (sb_real)insertion;
    steer->inserted += command->insertion;
}

NDL_API sb_result ndl_steer_update(ndl_steer *steer, const ndl_tip_pose *tip, sb_vec3 target,
                                   ndl_steer_command *command)
{
    ndli_pose pose;
    ndli_v3 goal = ndli_from(target);
    sb_result result;
    double distance;
    if (!steer || !tip || !command || steer->def.cookie != ndli_steer_cookie)
        return SB_ERROR_ARGUMENT;
    if (!sb_v3_is_finite(target))
        return SB_ERROR_NOT_FINITE;
    result = ndli_pose_read(tip, &pose);
    if (result != SB_OK)
        return result;
    distance = ndli_norm(ndli_sub(goal, pose.p));
    memset(command, 0, sizeof *command);
    if (steer->status == NDL_STEER_GOING) {
        ndli_steer_learn(steer, &pose);
        ndli_steer_plan(steer, &pose, goal);
        steer->updates++;
        if (steer->plan.length < (sb_real)0.25 * steer->def.step)
            steer->status = ndli_steer_end(steer, distance);
        else if (steer->updates >= steer->def.max_updates)
            steer->status = distance <= (double)steer->def.reach ? NDL_STEER_REACHED : NDL_STEER_LIMIT;
        else
            ndli_steer_move(steer, &pose, goal, command);
        steer->advance = command->insertion;
    }
    command->status = steer->status;
    command->distance = (sb_real)distance;
    command->expected = steer->plan.distance;
    return SB_OK;
}

/* ==== src/needle/steer_push.h ==== */
/* steer_push: what the planner of pushes needs of the controller's. Floor 6, internal. */
#ifndef NDL_STEER_PUSH_H
#define NDL_STEER_PUSH_H


#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* The same def, its directions made unit vectors. */
NDLI_API ndl_push_def ndli_push_unit(const ndl_push_def *def);
/* The way that a point has still to go, across the path: onto it, or out of the cylinder about it. */
NDLI_API ndli_v3 ndli_push_error(const ndl_push_def *unit, ndli_v3 point);
/* The force that the def allows which comes nearest to displacing a point of this compliance by `wanted` across the
 * path; returns what that leaves (m). */
NDLI_API double ndli_push_try(const ndl_push_def *unit, const sb_mat3 *compliance, ndli_v3 wanted, ndli_v3 *force);
#endif

#endif /* NDL_STEER_PUSH_H */

/* ==== src/needle/steer_push.c ==== */
/* steer_push: the manipulator that moves a point inside the tissue onto a path, or out of its way. */

static const unsigned ndli_push_cookie = 0x70736831u;

/* What the force may be: |f| <= most and within the cone about `axis` (any direction when `grip`). */
typedef struct ndli_push_set {
    ndli_v3 axis;
    double sine, cosine, most;
    int grip;
} ndli_push_set;

NDL_API ndl_push_def ndl_default_push_def(void)
{
    ndl_push_def def;
    memset(&def, 0, sizeof def);
    def.cone = (sb_real)0.5;
    def.proportional = (sb_real)0.3;
    def.integral = 1;
    def.max_rate = SB_REAL_MAX;
    def.tolerance = (sb_real)5e-4;
    def.cookie = ndli_push_cookie;
    return def;
}

static ndli_v3 ndli_push_across(const ndl_push_def *def, ndli_v3 v)
{
    ndli_v3 t = ndli_from(def->line_direction);
    return ndli_madd(v, -ndli_dot(v, t), t);
}

/* The compliance across the path, P C with P = I - t t^T. */
static ndli_m3 ndli_push_compliance(const ndl_push_def *def, const sb_mat3 *compliance)
{
    ndli_m3 a;
    for (int j = 0; j < 3; j++) {
        ndli_v3 column = ndli_push_across(def, ndli_from(sb_m3_column(*compliance, j)));
        a.m[0][j] = column.x;
        a.m[1][j] = column.y;
        a.m[2][j] = column.z;
    }
    return a;
}

static double ndli_push_size(const ndli_m3 *a)
{
    double sum = 0;
    for (int i = 0; i < 9; i++)
        sum += a->m[i / 3][i % 3] * a->m[i / 3][i % 3];
    return sqrt(sum);
}

static ndli_push_set ndli_push_set_of(const ndl_push_def *def)
{
    ndli_push_set set;
    set.axis = ndli_from(def->direction);
    set.grip = !(ndli_dot(set.axis, set.axis) > 0);
    set.most = (double)def->max_force;
    sbi_dense_sin_cos((double)def->cone, &set.sine, &set.cosine);
    return set;
}

/* The nearest force of the set: first of the cone, then of the ball (a cone's nearest point scaled stays in it). */
static ndli_v3 ndli_push_project(const ndli_push_set *set, ndli_v3 f)
{
    double length;
    if (!set->grip) {
        double along = ndli_dot(f, set->axis);
        ndli_v3 side = ndli_madd(f, -along, set->axis);
        double out = ndli_norm(side);
        if (out * set->cosine > along * set->sine) { /* outside the cone: onto its nearest generator, or its apex */
            double on = along * set->cosine + out * set->sine;
            if (!(on > 0))
                return ndli_v(0, 0, 0);
            f = ndli_scale(on * set->cosine, set->axis);
            if (out > 0)
                f = ndli_madd(f, on * set->sine / out, side);
        }
    }
    length = ndli_norm(f);
    return length > set->most ? ndli_scale(set->most / length, f) : f;
}

/* The force of the set that minimises |A f - u|^2 + (1e-3 |A|)^2 |f|^2, by accelerated projected gradients (FISTA) from
 * `f`. The second term keeps forces that move nothing out; it costs an error of 1e-6 of u along the best direction. */
static ndli_v3 ndli_push_solve(const ndli_m3 *a, const ndli_push_set *set, ndli_v3 u, ndli_v3 f)
{
    double size = ndli_push_size(a), rate = 1 / (size * size * (1 + 1e-6)), momentum = 1;
    ndli_v3 ahead = f, now = f;
    for (int i = 0; i < 200; i++) {
        ndli_v3 r = ndli_sub(ndli_m_apply(a, ahead), u), g = ndli_m_tapply(a, r), next;
        double grown = 0.5 * (1 + sqrt(1 + 4 * momentum * momentum));
        g = ndli_madd(g, 1e-6 * size * size, ahead);
        next = ndli_push_project(set, ndli_madd(ahead, -rate, g));
        if (ndli_dot(ndli_sub(next, now), ndli_sub(ahead, next)) > 0) { /* past the goal: the momentum is lost */
            momentum = 1;
            ahead = next;
        } else {
            ahead = ndli_madd(next, (momentum - 1) / grown, ndli_sub(next, now));
            momentum = grown;
        }
        now = next;
    }
    return now;
}

/* ---- creation ---- */

static int ndli_push_positive(sb_real x) { return x > 0 && x <= SB_REAL_MAX; }
static int ndli_push_not_negative(sb_real x) { return x >= 0 && x <= SB_REAL_MAX; }

static int ndli_push_finite(const sb_mat3 *a)
{
    for (int i = 0; i < 9; i++)
        if (!sb_is_finite(a->m[i / 3][i % 3]))
            return 0;
    return 1;
}

static sb_result ndli_push_check(const ndl_push_def *def, sb_error *error)
{
    if (def->cookie != ndli_push_cookie)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def does not come from ndl_default_push_def()");
    if (!sb_v3_is_finite(def->line_point) || !sb_v3_is_finite(def->line_direction) || !sb_v3_is_finite(def->direction))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "line_point, line_direction or direction is not finite");
    if (!(sb_v3_norm(def->line_direction) > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "line_direction has no length");
    if (!ndli_push_not_negative(def->clear_radius) || !(def->cone >= 0) || !(def->cone <= (sb_real)1.5707964))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "clear_radius must not be negative, cone between 0 and pi/2");
    if (!ndli_push_positive(def->max_force) || !ndli_push_positive(def->max_rate) ||
        !ndli_push_positive(def->tolerance))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_force, max_rate and tolerance must be finite and above 0");
    if (!ndli_push_not_negative(def->proportional) || !ndli_push_not_negative(def->integral))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "proportional and integral must be finite and not negative");
    return SB_OK;
}

NDLI_API ndl_push_def ndli_push_unit(const ndl_push_def *def)
{
    ndl_push_def unit = *def;
    sb_real size = sb_v3_norm(def->direction);
    unit.line_direction = sb_v3_scale(1 / sb_v3_norm(def->line_direction), def->line_direction);
    if (size > 0)
        unit.direction = sb_v3_scale(1 / size, def->direction);
    return unit;
}

NDL_API sb_result ndl_push_begin(const ndl_push_def *def, ndl_push *push, sb_error *error)
{
    ndl_push_def unit;
    ndli_m3 a;
    sb_result result;
    if (!def || !push)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def or push is NULL");
    result = ndli_push_check(def, error);
    if (result != SB_OK)
        return result;
    if (!ndli_push_finite(&def->compliance))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "compliance is not finite");
    unit = ndli_push_unit(def);
    a = ndli_push_compliance(&unit, &unit.compliance);
    if (!(ndli_push_size(&a) > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "compliance moves nothing across the path");
    memset(push, 0, sizeof *push);
    push->def = unit;
    return SB_OK;
}

/* ---- control ---- */

NDLI_API ndli_v3 ndli_push_error(const ndl_push_def *def, ndli_v3 point)
{
    ndli_v3 off = ndli_push_across(def, ndli_sub(point, ndli_from(def->line_point)));
    double radius = (double)def->clear_radius, distance = ndli_norm(off), inside = distance;
    if (!(radius > 0))
        return ndli_scale(-1, off);
    if (distance >= radius)
        return ndli_v(0, 0, 0);
    if (!(distance > 0)) /* on the axis every way out is as far: the way the manipulator pushes, or any */
        off = ndli_push_across(def, ndli_from(def->direction)), distance = ndli_norm(off);
    if (!(distance > 1e-6))
        return ndli_scale(radius, ndli_from(sb_v3_perpendicular(def->line_direction)));
    return ndli_scale((radius - inside) / distance, off);
}

NDL_API sb_result ndl_push_update(ndl_push *push, sb_vec3 point, sb_real dt, sb_vec3 *force)
{
    ndli_push_set set;
    ndli_m3 a;
    ndli_v3 error, integral, asked, now, f, step, left;
    double most, distance;
    if (!push || !force || push->def.cookie != ndli_push_cookie || !(dt > 0))
        return SB_ERROR_ARGUMENT;
    if (!sb_v3_is_finite(point) || !sb_is_finite(dt))
        return SB_ERROR_NOT_FINITE;
    set = ndli_push_set_of(&push->def);
    a = ndli_push_compliance(&push->def, &push->def.compliance);
    error = ndli_push_error(&push->def, ndli_from(point));
    integral = ndli_madd(ndli_from(push->integral), (double)push->def.integral * (double)dt, error);
    asked = ndli_madd(integral, (double)push->def.proportional, error);
    now = ndli_from(push->force);
    f = ndli_push_solve(&a, &set, asked, now);
    step = ndli_sub(f, now);
    most = (double)push->def.max_rate * (double)dt;
    distance = ndli_norm(step);
    if (distance > most)
        f = ndli_madd(now, most / distance, step); /* both ends are in the set, and it is convex */
    left = ndli_sub(asked, ndli_m_apply(&a, f));
    push->limited = ndli_norm(left) > 1e-3 * (ndli_norm(asked) + (double)push->def.tolerance);
    if (!push->limited || ndli_dot(left, error) < 0)
        push->integral = ndli_to(integral);
    push->force = ndli_to(f);
    push->error = ndli_to(error);
    push->arrived = ndli_norm(error) <= (double)push->def.tolerance;
    *force = push->force;
    return SB_OK;
}

/* ---- where to push ---- */

NDLI_API double ndli_push_try(const ndl_push_def *unit, const sb_mat3 *compliance, ndli_v3 wanted, ndli_v3 *force)
{
    ndli_push_set set = ndli_push_set_of(unit);
    ndli_m3 a = ndli_push_compliance(unit, compliance);
    ndli_v3 none = ndli_v(0, 0, 0);
    *force = ndli_push_size(&a) > 0 ? ndli_push_solve(&a, &set, wanted, none) : none;
    return ndli_norm(ndli_sub(wanted, ndli_m_apply(&a, *force)));
}

NDL_API sb_result ndl_push_choose(const ndl_push_def *def, const sb_mat3 *compliances, const sb_vec3 *directions,
                                  int count, sb_vec3 point, int *best, sb_vec3 *force, sb_real *left, sb_error *error)
{
    ndl_push_def unit;
    ndli_v3 best_force = ndli_v(0, 0, 0);
    double best_left = 0;
    int found = -1, best_there = 0;
    sb_result result;
    if (!def || !compliances || !best || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def, compliances or best is NULL, or there are no candidates");
    result = ndli_push_check(def, error);
    if (result != SB_OK)
        return result;
    if (!sb_v3_is_finite(point))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the point is not finite");
    for (int i = 0; i < count; i++)
        if (!ndli_push_finite(compliances + i) || (directions && !sb_v3_is_finite(directions[i])))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "candidate %d is not finite", i);
    for (int i = 0; i < count; i++) {
        ndl_push_def candidate = *def;
        ndli_v3 f;
        double rest;
        int there;
        if (directions)
            candidate.direction = directions[i];
        unit = ndli_push_unit(&candidate);
        rest = ndli_push_try(&unit, compliances + i, ndli_push_error(&unit, ndli_from(point)), &f);
        there = rest <= (double)def->tolerance;
        if (found < 0 || there > best_there ||
            (there == best_there && (there ? ndli_norm(f) < ndli_norm(best_force) : rest < best_left))) {
            found = i;
            best_force = f;
            best_left = rest;
            best_there = there;
        }
    }
    *best = found;
    if (force)
        *force = ndli_to(best_force);
    if (left)
        *left = (sb_real)best_left;
    return SB_OK;
}

/* ==== src/needle/guide.c ==== */
/* guide: straight paths past tissue that is pushed aside, by chance and climbing. */

enum {
    NDLI_GUIDE_SCAN = 64,     /* points of a path at which obstacles are looked for */
    NDLI_GUIDE_MOST = 1000000 /* paths of either kind */
};

static const unsigned ndli_guide_cookie = 0x67756931u;

NDL_API ndl_guide_def ndl_default_guide_def(sb_vec3 target, sb_vec3 entry, sb_vec3 direction)
{
    sb_real distance = sb_v3_norm(sb_v3_sub(target, entry));
    ndl_guide_def def;
    memset(&def, 0, sizeof def);
    def.target = target;
    def.entry = entry;
    def.direction = direction;
    def.entry_radius = def.shift = distance / 10;
    def.max_lean = (sb_real)0.6;
    def.clearance = distance / 50;
    def.tolerance = distance / 200;
    def.samples = 200;
    def.climbs = 100;
    def.cookie = ndli_guide_cookie;
    return def;
}

/* ---- arguments ---- */

static int ndli_guide_positive(sb_real x) { return x > 0 && x <= SB_REAL_MAX; }
static int ndli_guide_not_negative(sb_real x) { return x >= 0 && x <= SB_REAL_MAX; }

static sb_result ndli_guide_check_place(const ndl_push_place *place, int i, sb_error *error)
{
    if (!sb_v3_is_finite(place->direction))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the direction of place %d is not finite", i);
    if (!(place->cone >= 0) || !(place->cone <= (sb_real)1.5707964))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the cone of place %d must be between 0 and pi/2", i);
    if (!ndli_guide_positive(place->max_force) || !ndli_guide_positive(place->weight))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_force and weight of place %d must be finite and above 0", i);
    return SB_OK;
}

static sb_result ndli_guide_check_lists(const ndl_guide_def *def, sb_error *error)
{
    sb_result result = SB_OK;
    if (def->obstacle_count < 0 || (def->obstacle_count > 0 && !def->obstacles))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "obstacle_count is negative, or there are no obstacles to count");
    if (def->place_count < 0 || def->place_count > NDL_GUIDE_PLACES ||
        (def->place_count > 0 && (!def->places || !def->model)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "place_count is not in 0 ... %d, or places or model are missing",
                        NDL_GUIDE_PLACES);
    for (int i = 0; i < def->obstacle_count && result == SB_OK; i++)
        result = ndli_obstacle_check(def->obstacles + i, i, error);
    for (int i = 0; i < def->place_count && result == SB_OK; i++)
        result = ndli_guide_check_place(def->places + i, i, error);
    return result;
}

static sb_result ndli_guide_check(const ndl_guide_def *def, sb_error *error)
{
    ndli_v3 way;
    if (def->cookie != ndli_guide_cookie)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def does not come from ndl_default_guide_def()");
    if (!sb_v3_is_finite(def->target) || !sb_v3_is_finite(def->entry) || !sb_v3_is_finite(def->direction))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "target, entry or direction is not finite");
    way = ndli_sub(ndli_from(def->target), ndli_from(def->entry));
    if (!(ndli_norm(ndli_from(def->direction)) > 0) || !(ndli_dot(way, ndli_from(def->direction)) > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the target does not lie before the entry, in its direction");
    if (!ndli_guide_not_negative(def->entry_radius) || !ndli_guide_not_negative(def->shift) || !(def->max_lean >= 0) ||
        !(def->max_lean <= (sb_real)1.5))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "entry_radius and shift must not be negative, max_lean between 0 and 1.5");
    if (!ndli_guide_positive(def->clearance) || !ndli_guide_positive(def->tolerance))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "clearance and tolerance must be finite and above 0");
    if (def->samples < 1 || def->samples > NDLI_GUIDE_MOST || def->climbs < 0 || def->climbs > NDLI_GUIDE_MOST)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "samples must be 1 ... %d, climbs 0 ... %d", NDLI_GUIDE_MOST,
                        NDLI_GUIDE_MOST);
    return ndli_guide_check_lists(def, error);
}

/* ---- one path ---- */

/* A path by four numbers: where it goes through the entry's disc and past the target, in radii. */
typedef struct ndli_guide_path {
    double z[4];
    ndli_v3 entry, t;
    double length; /* to beside the target at rest */
} ndli_guide_path;

/* A place where an obstacle is deepest in the cylinder about a path. */
typedef struct ndli_guide_point {
    ndli_v3 at, out; /* on the path; the way that the path would have to go, unit */
    double distance; /* of the obstacle from the path, negative: the path goes through it */
    int obstacle;
} ndli_guide_point;

typedef struct ndli_guide_work {
    const ndl_guide_def *def;
    sb_error *error;
    double penalty;   /* N/m of what is left: half a tolerance's worth costs as much as all forces together */
    sb_result result; /* of the model */
} ndli_guide_work;

/* Two directions across another. */
static void ndli_guide_across(ndli_v3 t, ndli_v3 *a, ndli_v3 *b)
{
    *a = ndli_from(sb_v3_perpendicular(ndli_to(t)));
    *a = ndli_madd(*a, -ndli_dot(*a, t), t);
    *a = ndli_scale(1 / ndli_norm(*a), *a);
    *b = ndli_cross(t, *a);
}

/* 0: it leans too much. */
static int ndli_guide_path_of(const ndl_guide_def *def, const double z[4], ndli_guide_path *path)
{
    ndli_v3 middle = ndli_from(def->direction), target = ndli_from(def->target), a, b, aim;
    double sine, cosine;
    middle = ndli_scale(1 / ndli_norm(middle), middle);
    memcpy(path->z, z, sizeof path->z);
    ndli_guide_across(middle, &a, &b);
    path->entry = ndli_madd(ndli_from(def->entry), (double)def->entry_radius * z[0], a);
    path->entry = ndli_madd(path->entry, (double)def->entry_radius * z[1], b);
    aim = ndli_sub(target, path->entry);
    if (!(ndli_dot(aim, middle) > 0))
        return 0;
    aim = ndli_scale(1 / ndli_norm(aim), aim);
    ndli_guide_across(aim, &a, &b);
    aim = ndli_madd(target, (double)def->shift * z[2], a);
    aim = ndli_sub(ndli_madd(aim, (double)def->shift * z[3], b), path->entry);
    path->t = ndli_scale(1 / ndli_norm(aim), aim);
    path->length = ndli_dot(ndli_sub(target, path->entry), path->t);
    sbi_dense_sin_cos((double)def->max_lean, &sine, &cosine);
    return path->length > 0 && ndli_dot(path->t, middle) >= cosine - 1e-9;
}

/* One that is no number is as far within the obstacle as the target is away. */
static double ndli_guide_distance(const ndl_guide_def *def, int obstacle, ndli_v3 p)
{
    double distance = (double)ndl_obstacle_distance(def->obstacles + obstacle, ndli_to(p));
    return distance == distance ? distance : -ndli_norm(ndli_sub(ndli_from(def->target), ndli_from(def->entry)));
}

/* The way out of an obstacle at a point, across the path; any where it has none. */
static ndli_v3 ndli_guide_way_out(const ndl_guide_def *def, int obstacle, ndli_v3 p, ndli_v3 t)
{
    double h = 0.1 * (double)def->clearance, slope[2], size;
    ndli_v3 axes[2];
    ndli_guide_across(t, axes, axes + 1);
    for (int k = 0; k < 2; k++)
        slope[k] = ndli_guide_distance(def, obstacle, ndli_madd(p, h, axes[k])) -
                   ndli_guide_distance(def, obstacle, ndli_madd(p, -h, axes[k]));
    size = sqrt(slope[0] * slope[0] + slope[1] * slope[1]);
    if (!(size > 1e-6 * h)) /* straight at its middle */
        return axes[0];
    return ndli_add(ndli_scale(slope[0] / size, axes[0]), ndli_scale(slope[1] / size, axes[1]));
}

/* Puts a point among the deepest, which are first. */
static int ndli_guide_insert(ndli_guide_point *points, int count, const ndli_guide_point *point)
{
    int at = count < NDL_GUIDE_PHASES - 1 ? count : count - 1;
    if (count == NDL_GUIDE_PHASES - 1 && point->distance >= points[at].distance)
        return count;
    while (at > 0 && points[at - 1].distance > point->distance) {
        points[at] = points[at - 1];
        at--;
    }
    points[at] = *point;
    return count < NDL_GUIDE_PHASES - 1 ? count + 1 : count;
}

/* Points of interest of a path at rest, deepest first; returns how many. */
static int ndli_guide_find(const ndl_guide_def *def, const ndli_guide_path *path, ndli_guide_point *points)
{
    int count = 0;
    for (int o = 0; o < def->obstacle_count; o++) {
        double d[3] = {HUGE_VAL, HUGE_VAL, HUGE_VAL};
        for (int i = 0; i <= NDLI_GUIDE_SCAN; i++) {
            ndli_guide_point point;
            d[0] = d[1], d[1] = d[2];
            d[2] = i < NDLI_GUIDE_SCAN
                       ? ndli_guide_distance(def, o,
                                             ndli_madd(path->entry, path->length * i / (NDLI_GUIDE_SCAN - 1), path->t))
                       : HUGE_VAL;
            if (!(d[1] < (double)def->clearance) || d[0] < d[1] || d[2] <= d[1])
                continue;
            point.at = ndli_madd(path->entry, path->length * (i - 1) / (NDLI_GUIDE_SCAN - 1), path->t);
            point.out = ndli_guide_way_out(def, o, point.at, path->t);
            point.distance = d[1];
            point.obstacle = o;
            count = ndli_guide_insert(points, count, &point);
        }
    }
    return count;
}

/* ---- pushes ---- */

/* How the forces of all phases but one (-1: of all) displace a point, by the model. */
static ndli_v3 ndli_guide_moved(ndli_guide_work *w, const ndl_guide *guide, int but, ndli_v3 point)
{
    ndli_v3 moved = ndli_v(0, 0, 0);
    for (int k = 0; k < guide->phase_count; k++) {
        const ndl_guide_phase *phase = guide->phases + k;
        sb_mat3 c;
        if (k == but || phase->place < 0 || !w->def->model(w->def->user, ndli_to(point), phase->place, &c))
            continue;
        moved = ndli_add(moved, ndli_from(sb_m3_apply(c, phase->force)));
    }
    if (!sb_v3_is_finite(ndli_to(moved)))
        w->result = sbi_fail(w->error, SB_ERROR_NOT_FINITE, "the model's compliance is not finite");
    return moved;
}

static void ndli_guide_begin(const ndl_guide_def *def, const ndli_guide_path *path, int obstacle,
                             ndl_guide_phase *phase)
{
    memset(phase, 0, sizeof *phase);
    phase->push = ndl_default_push_def();
    phase->push.tolerance = def->tolerance;
    phase->push.line_direction = ndli_to(path->t);
    phase->push.line_point = ndli_to(path->entry);
    phase->point = def->target;
    phase->obstacle = obstacle;
    phase->place = -1;
}

/* A point of interest lies on the obstacle's side that is farthest out and has to go beyond a plane beside the path,
 * which is as far from it as the clearance and `more` (m). A wide cylinder is as good as a plane, and lets the point
 * slide along it. */
static void ndli_guide_ask(const ndl_guide_def *def, const ndli_guide_point *point, double more, ndl_guide_phase *phase)
{
    double clear = (double)def->clearance + more, depth = clear - point->distance, radius = 10 * depth + clear;
    phase->point = ndli_to(ndli_madd(point->at, -point->distance, point->out));
    phase->push.clear_radius = (sb_real)radius;
    phase->push.line_point = ndli_to(ndli_madd(point->at, radius - clear, point->out));
}

/* The way that the point of a phase has still to go, the others pushing. */
static ndli_v3 ndli_guide_wanted(ndli_guide_work *w, const ndl_guide *guide, int k)
{
    const ndl_guide_phase *phase = guide->phases + k;
    ndli_v3 X = ndli_from(phase->point);
    return ndli_push_error(&phase->push, ndli_add(X, ndli_guide_moved(w, guide, k, X)));
}

static int ndli_guide_used(const ndl_guide *guide, int place)
{
    for (int k = 0; k < guide->phase_count; k++)
        if (guide->phases[k].place == place)
            return 1;
    return 0;
}

/* The place that does it with least force, or that leaves least. */
static void ndli_guide_choose(ndli_guide_work *w, const ndl_guide *guide, ndli_v3 wanted, ndl_guide_phase *phase)
{
    const ndl_guide_def *def = w->def;
    double best = HUGE_VAL;
    for (int i = 0; i < def->place_count; i++) {
        const ndl_push_place *place = def->places + i;
        ndl_push_def push = phase->push;
        ndli_v3 force;
        double left, cost;
        if (ndli_guide_used(guide, i) || !def->model(def->user, phase->point, i, &push.compliance))
            continue;
        push.direction = place->direction;
        push.cone = place->cone;
        push.max_force = place->max_force;
        push = ndli_push_unit(&push);
        left = ndli_push_try(&push, &push.compliance, wanted, &force);
        if (!ndli_is_finite(left)) {
            w->result = sbi_fail(w->error, SB_ERROR_NOT_FINITE, "the model's compliance for place %d is not finite", i);
            return;
        }
        cost = (double)place->weight * ndli_norm(force) + w->penalty * fmax(0, left - 0.5 * (double)def->tolerance);
        if (!(cost < best) || !(ndli_norm(force) > 0))
            continue;
        best = cost;
        phase->push = push;
        phase->place = i;
        phase->force = ndli_to(force);
    }
}

/* The force of a phase, the others' being as they are; first of all its place. */
static void ndli_guide_relax(ndli_guide_work *w, ndl_guide *guide, int k)
{
    ndl_guide_phase *phase = guide->phases + k;
    ndli_v3 wanted = ndli_guide_wanted(w, guide, k), force;
    if (phase->place < 0 && ndli_norm(wanted) > 0.25 * (double)w->def->tolerance) {
        ndli_guide_choose(w, guide, wanted, phase);
    } else if (phase->place >= 0) {
        ndli_push_try(&phase->push, &phase->push.compliance, wanted, &force);
        phase->force = ndli_to(force);
    }
}

/* Distance of an obstacle (-1: of the nearest) from the path, as all forces have moved it: from the material points
 * that now lie on the path. */
static double ndli_guide_clearance(ndli_guide_work *w, const ndl_guide *guide, const ndli_guide_path *path,
                                   double least[NDL_GUIDE_PHASES])
{
    double nearest = (double)SB_REAL_MAX;
    for (int k = 0; k < NDL_GUIDE_PHASES; k++)
        least[k] = (double)SB_REAL_MAX;
    for (int i = 0; i < NDLI_GUIDE_SCAN && w->def->obstacle_count > 0; i++) {
        ndli_v3 x = ndli_madd(path->entry, path->length * i / (NDLI_GUIDE_SCAN - 1), path->t);
        ndli_v3 X = ndli_sub(x, ndli_guide_moved(w, guide, -1, x)); /* X + u(X) = x by two steps */
        X = ndli_sub(x, ndli_guide_moved(w, guide, -1, X));
        for (int o = 0; o < w->def->obstacle_count; o++) {
            double d = ndli_guide_distance(w->def, o, X);
            nearest = fmin(nearest, d);
            for (int k = 0; k < guide->phase_count; k++)
                if (guide->phases[k].obstacle == o)
                    least[k] = fmin(least[k], d);
        }
    }
    return nearest;
}

/* The phases of a path, nothing being pushed yet. */
static void ndli_guide_list(const ndl_guide_def *def, const ndli_guide_path *path, const ndli_guide_point *points,
                            int count, ndl_guide *guide)
{
    memset(guide, 0, sizeof *guide);
    guide->entry = ndli_to(path->entry);
    guide->direction = ndli_to(path->t);
    guide->phase_count = count + 1;
    for (int k = 0; k <= count; k++) {
        ndl_guide_phase *phase = guide->phases + k;
        ndli_guide_begin(def, path, k < count ? points[k].obstacle : -1, phase);
        if (k < count)
            ndli_guide_ask(def, points + k, 0, phase);
        phase->depth = (sb_real)ndli_norm(ndli_push_error(&phase->push, ndli_from(phase->point)));
    }
}

/* What all forces leave, and what they cost; returns both as one cost (N): a path that does not reach costs more than
 * all forces together. */
static double ndli_guide_judge(ndli_guide_work *w, ndli_guide_path *path, ndl_guide *guide,
                               double least[NDL_GUIDE_PHASES])
{
    const ndl_guide_def *def = w->def;
    double tolerance = (double)def->tolerance, late = 0, close;
    guide->cost = 0;
    for (int k = 0; k < guide->phase_count; k++) {
        ndl_guide_phase *phase = guide->phases + k;
        ndli_v3 X = ndli_from(phase->point), x = ndli_add(X, ndli_guide_moved(w, guide, -1, X));
        phase->left = (sb_real)ndli_norm(ndli_push_error(&phase->push, x));
        if (phase->place >= 0)
            guide->cost += def->places[phase->place].weight * sb_v3_norm(phase->force);
        if (phase->obstacle < 0) {
            late = fmax(0, (double)phase->left - tolerance);
            path->length = ndli_dot(ndli_sub(x, path->entry), path->t);
        }
    }
    guide->length = (sb_real)path->length;
    guide->clearance = (sb_real)ndli_guide_clearance(w, guide, path, least);
    close = fmax(0, (double)def->clearance - tolerance - (double)guide->clearance);
    guide->reaches = late == 0 && close == 0 && path->length > 0;
    return (double)guide->cost + w->penalty * (late + close + (guide->reaches ? 0 : 0.5 * tolerance));
}

/* The plan of a path: forces are taken one after another, each as the others ask for, until they agree; obstacles are
 * asked to go farther where that leaves them too near. Returns its cost. */
static double ndli_guide_plan(ndli_guide_work *w, const double z[4], ndl_guide *guide)
{
    const int rounds = 4, sweeps = 4;
    ndli_guide_path path;
    ndli_guide_point points[NDL_GUIDE_PHASES];
    double more[NDL_GUIDE_PHASES] = {0}, least[NDL_GUIDE_PHASES], best = HUGE_VAL, lacks = HUGE_VAL;
    ndl_guide tried;
    int count;
    if (!ndli_guide_path_of(w->def, z, &path))
        return HUGE_VAL;
    count = ndli_guide_find(w->def, &path, points);
    ndli_guide_list(w->def, &path, points, count, &tried);
    for (int r = 0; r < rounds && lacks > 0.5 * (double)w->def->tolerance; r++) {
        double cost;
        for (int n = 0; n < sweeps * (count + 1) && w->result == SB_OK; n++)
            ndli_guide_relax(w, &tried, n % (count + 1));
        cost = ndli_guide_judge(w, &path, &tried, least);
        if (cost < best) {
            best = cost;
            *guide = tried;
        }
        lacks = (double)tried.phases[count].left - 0.5 * (double)w->def->tolerance;
        for (int k = 0; k < count; k++) {
            double lack = (double)w->def->clearance - least[k];
            more[k] += fmax(0, lack);
            lacks = fmax(lacks, lack);
            ndli_guide_ask(w->def, points + k, more[k], tried.phases + k);
        }
    }
    return best;
}

/* ---- the search ---- */

/* Evenly spread in [-1, 1], the same on every machine (splitmix64). */
static double ndli_guide_random(uint64_t *seed)
{
    uint64_t z = *seed += UINT64_C(0x9e3779b97f4a7c15);
    z = (z ^ z >> 30) * UINT64_C(0xbf58476d1ce4e5b9);
    z = (z ^ z >> 27) * UINT64_C(0x94d049bb133111eb);
    return 2 * ((double)((z ^ z >> 31) >> 11) / 9007199254740992.0) - 1;
}

/* Into the unit discs of entry and target. */
static void ndli_guide_bound(double z[4])
{
    for (int k = 0; k < 4; k += 2) {
        double size = sqrt(z[k] * z[k] + z[k + 1] * z[k + 1]);
        if (size > 1)
            z[k] /= size, z[k + 1] /= size;
    }
}

static void ndli_guide_search(ndli_guide_work *w, ndl_guide *guide)
{
    uint64_t seed = w->def->seed;
    double best = HUGE_VAL, now[4] = {0, 0, 0, 0}, reach = 0.5;
    for (int i = 0; i < w->def->samples + w->def->climbs && w->result == SB_OK; i++) {
        ndl_guide tried;
        double z[4], cost;
        int climbs = i >= w->def->samples;
        for (int k = 0; k < 4; k++)
            z[k] = i == 0 ? 0 : climbs ? now[k] + reach * ndli_guide_random(&seed) : ndli_guide_random(&seed);
        ndli_guide_bound(z);
        cost = ndli_guide_plan(w, z, &tried);
        if (cost < best) {
            best = cost;
            memcpy(now, z, sizeof now);
            *guide = tried;
        } else if (climbs) {
            reach *= 0.95;
        }
    }
}

NDL_API sb_result ndl_guide_make(const ndl_guide_def *def, ndl_guide *guide, sb_error *error)
{
    ndli_guide_work w;
    ndl_guide found;
    sb_result result;
    double most = 0;
    if (!def || !guide)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def or guide is NULL");
    result = ndli_guide_check(def, error);
    if (result != SB_OK)
        return result;
    memset(&w, 0, sizeof w);
    memset(&found, 0, sizeof found);
    w.def = def;
    w.error = error;
    for (int i = 0; i < def->place_count; i++)
        most += (double)def->places[i].weight * (double)def->places[i].max_force;
    w.penalty = (most > 0 ? 2 * most : 1) / (double)def->tolerance;
    if (!(w.penalty <= (double)SB_REAL_MAX))
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "weights and max_force of the places come to %g N over a tolerance "
                        "of %g m: too much",
                        most, (double)def->tolerance);
    ndli_guide_search(&w, &found);
    if (w.result != SB_OK)
        return w.result;
    if (found.phase_count == 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "no path leans less than max_lean");
    *guide = found;
    return SB_OK;
}

/* ==== src/needle/couple_line.h ==== */
/* couple_line: what the coupled solve keeps of a rod, its line of nodes. Floor 6, internal: couple_line.c is the rod's
 * part of the linear system, couple.c finds the friction states.
 *
 * Rod nodes first .. first + count - 1 sit on the body's nodes path[0 .. count - 1]. The unknowns are displacements
 * over the step: of the body's nodes, u; the slip alpha of a coupled node along its tangent t; and the motion z of a
 * free one. Rod node i moves by
 *
 *     u + t alpha   coupled        z   free        target - x   held
 *
 * so that normal forces and static friction need no multipliers: they are the balance of the rod's rows. Where forces
 * balance before the end of the step (generalised alpha), unknowns are those of that level; the whole way is 1/level of
 * it, and the force there the same share between that of the last step and that at the end. The rod is
 * stepped by implicit Euler: its own vibrations are far above what steps resolve, and Euler leaves none of them. With
 * constraints on displacements that is passive next to a body stepped by Newmark (the rod's inertia, damping and
 * stiffness seen through the body's velocity have no negative real part on the unit circle). */
#ifndef NDL_COUPLE_LINE_H
#define NDL_COUPLE_LINE_H


/* Unknowns of a rod node: the first three are z (in the block solve also u), the fourth is alpha. A bend joins the
 * first of node i - 2 to the last of node i. */
enum { NDLI_LINE_UNKNOWNS = 4, NDLI_LINE_WIDTH = 11 };

typedef struct ndli_line {
    ndl_rod *rod; /* borrowed */
    int capacity; /* rod nodes there is room for */
    sb_allocator allocator;
    void *memory;

    /* set by the room above before a solve */
    int first, count; /* rod node of path[0], and how many there are; node_count and 0: the rod is not in tissue. A node
                       * may follow: a tip that is hardly in has none of its own in the tissue */
    const int *path;  /* [count] nodes of the body; of a rod that is held by rows nothing */
    struct ndli_hold *holds; /* [capacity] of such a rod (couple_rows.h), from the node before `first` on: there its
                              * edge is held where it goes in. Its nodes have unknowns z throughout. NULL of others */
    unsigned char *state;    /* [nodes] ndl_contact; as found after it */
    double *friction;        /* [nodes] N: limit of static friction, and dynamic friction */
    double *viscous;         /* [nodes] N s/m: friction per slip speed */
    double cutting;          /* N: what holds the tip back beside friction while it goes forward */

    /* what a solve finds */
    double *slip;      /* [nodes] m along the tangent, of the rod past the tissue */
    ndli_v3 *move;     /* [nodes] displacement of the rod's nodes (m) */
    ndli_v3 *contact;  /* [nodes] force of the tissue on the rod (N); before it, that of the last step */
    ndli_v3 *reaction; /* [nodes] force of the supports on the rod (N) */

    /* holds nothing between solves */
    double dt, level; /* level: share of the new forces in the body's equations */
    const sb_matrix *matrix;
    ndli_v3 *tangent; /* [nodes] */
    ndli_v3 *load;    /* [nodes] right-hand side (N) */
    ndli_v3 *before;  /* [nodes] contact of the last step (N) */
    ndli_v3 *motion;  /* [nodes] */
    ndli_v3 *force;   /* [nodes] H times motion (N) */
    double *band;     /* [4 nodes][NDLI_LINE_WIDTH + 1] */
    double *right;    /* [4 nodes] */
} ndli_line;

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* 0: no memory. */
NDLI_API int ndli_line_create(ndli_line *line, ndl_rod *rod, const sb_allocator *allocator);
NDLI_API void ndli_line_free(ndli_line *line); /* safe on zeros */

SB_INLINE int ndli_line_is_slipping(const ndli_line *line, int i) { return line->state[i] > NDL_STATIC; }
/* 1 towards the tip, -1 towards the base. */
SB_INLINE int ndli_line_sign(const ndli_line *line, int i) { return line->state[i] == NDL_DYNAMIC_FORWARD ? 1 : -1; }
/* The first and the last node that has a state: what holds the tip acts at the last. */
SB_INLINE int ndli_line_rearmost(const ndli_line *line)
{
    return line->first - (line->holds && line->count > 0 ? 1 : 0);
}
SB_INLINE int ndli_line_foremost(const ndli_line *line) { return line->first + line->count - 1; }
/* Largest friction against slip of that sign (N). */
SB_INLINE double ndli_line_limit(const ndli_line *line, int i, int sign)
{
    return line->friction[i] + (sign > 0 && i == ndli_line_foremost(line) ? line->cutting : 0);
}
/* Nodes of the body that move as the rod's do. */
SB_INLINE int ndli_line_taken_count(const ndli_line *line) { return line->holds ? 0 : line->count; }
SB_INLINE int ndli_line_unknown_count(const ndli_line *line) { return NDLI_LINE_UNKNOWNS * line->rod->node_count; }

/* The rod's part of the system at its present shape: H, tangents, loads. Returns -1, or the node at which the rod is
 * folded. */
NDLI_API int ndli_line_linearise(ndli_line *line, const sbi_guest_step *step);
/* unknown[4 nodes] = where a solve starts: the rod goes on as it goes, nothing slips. */
NDLI_API void ndli_line_start(const ndli_line *line, double *unknown);
/* The band of what the rod's unknowns and its coupled nodes have among themselves at the present friction states;
 * matrix: the body's. */
NDLI_API void ndli_line_fill(ndli_line *line, const sb_matrix *matrix);
/* Factors it. 0: not positive definite. */
NDLI_API int ndli_line_factor(ndli_line *line);
/* Before a step: the contact forces are those at its start. */
NDLI_API void ndli_line_keep_contact(ndli_line *line);

/* The parts of a guest's calls; unknown: [4 nodes], nodes: [count][3] of the body's nodes on the path. */
/* y = loads - G x (loads != 0), or G x. */
NDLI_API void ndli_line_apply(ndli_line *line, int loads, const double *unknown, const double *nodes,
                              double *out_unknown, double *out_nodes);
/* z = (G + A)^-1 r on its rows. */
NDLI_API void ndli_line_solve_block(ndli_line *line, const double *unknown, const double *nodes, double *out_unknown,
                                    double *out_nodes);
/* vectors[i] += factor v, of a stride of reals. */
SB_INLINE void ndli_line_add_to(double *vectors, int stride, int i, double factor, ndli_v3 v)
{
    double *out = vectors + (size_t)stride * (size_t)i;
    out[0] += factor * v.x, out[1] += factor * v.y, out[2] += factor * v.z;
}
/* Force (N) on node i along its tangent that is known beforehand: friction while it slips. */
SB_INLINE double ndli_line_drag(const ndli_line *line, int i)
{
    int sign = ndli_line_sign(line, i);
    return -sign * ndli_line_limit(line, i, sign);
}
/* Viscous friction per slip (N/m). */
SB_INLINE double ndli_line_viscosity(const ndli_line *line, int i) { return line->viscous[i] / line->dt; }
/* The band += factor k between the first three unknowns of rod nodes a >= b. */
NDLI_API void ndli_line_add_to_band(ndli_line *line, int a, int b, double factor, const ndli_m3 *k);
/* slip, move, contact and reaction from the unknowns. */
NDLI_API void ndli_line_read(ndli_line *line, const double *unknown, const double *nodes);
#endif

#endif /* NDL_COUPLE_LINE_H */

/* ==== src/needle/couple_rows.h ==== */
/* couple_rows: a rod that springs hold at rows of a body's nodes. Floor 6, internal.
 *
 * A hold is where a rod node, or the point of its next edge at the skin, is tied to a material point of the body, x =
 * sum_a w_a x_a. The rod's nodes keep unknowns of their own; with s the rod's way past the tissue (m) the force on the
 * rod is
 *
 *     across  -k (I - t t^T) s       along  -k' t.s while it sticks, its friction while it slips
 *
 * Both springs are what the mesh does not show of the tissue about a line: a load q (N/m) moves the mesh as if it were
 * spread over a circle of a radius that goes with the elements, the needle's is smaller, and tissue gives so much more
 * there (Kelvin's line load; Peaceman's 1978 well radius carried over). So forces have a limit as meshes get finer,
 * nothing is stiffer than tissue, and a needle goes into elements of any kind, several into one. Friction is Tresca's,
 * its states are found as in couple.c: with a spring in series a step is a convex problem as before. */
#ifndef NDL_COUPLE_ROWS_H
#define NDL_COUPLE_ROWS_H


/* What ties rod node i, by its number. */
struct ndli_hold {
    double share;                     /* of the way from rod node i to the next one where it is; 0: at the node */
    int count;                        /* 0: nothing holds it */
    int places[SB_MAX_ELEMENT_NODES]; /* of its nodes in the guest's list */
    double weights[SB_MAX_ELEMENT_NODES];
    double length;        /* m of shaft that counts with it */
    double across, along; /* k, k' (N/m) */
    ndli_v3 tangent;
    ndli_v3 offset; /* s at the start of the step (m) */
};

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* What ndli_line_apply leaves out, which goes before it: added to out_unknown [4 nodes] and out_nodes [guest's
 * nodes][3]; nodes likewise. */
NDLI_API void ndli_rows_apply(ndli_line *line, int loads, const double *nodes, double *out_unknown, double *out_nodes);
/* Adds what holds have between the rod's own unknowns to its band. */
NDLI_API void ndli_rows_add_band(ndli_line *line);
/* contact, slip and reactions; after ndli_line_read. */
NDLI_API void ndli_rows_read(ndli_line *line, const double *nodes);
#endif

#endif /* NDL_COUPLE_ROWS_H */

/* ==== src/needle/couple_solve.h ==== */
/* couple_solve: all needles of a body as one guest of its solve. Floor 6, internal. */
#ifndef NDL_COUPLE_SOLVE_H
#define NDL_COUPLE_SOLVE_H


/* What the guest works on. The lines' states are the first guess; afterwards they hold those found, with the forces and
 * motions that go with them. Nothing of a rod's state changes. */
typedef struct ndli_couple {
    ndli_line *const *lines; /* [count] */
    int count;
    int rows; /* 1: rods are held by rows of the guest's nodes, else each has nodes of its own */
    int max_trials;
    ndl_couple_info info; /* trials, consistent: of the solve that has ended */
    sbi_guest guest;
    const sb_matrix *matrix; /* the body's, of the present system */
    int indefinite;          /* 1: the block of a set of friction states could not be factored */
    int trials;              /* of the present system */
    int fewest, stalled; /* how many states were contradicted at best, and for how many trials it has not been fewer */
} ndli_couple;

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* Makes the guest. unknown: [sum of ndli_line_unknown_count], nodes: [sum of the lines' counts], both borrowed until
 * the solve has ended. */
NDLI_API void ndli_couple_prepare(ndli_couple *couple, ndli_line *const *lines, int count, int max_trials,
                                  double *unknown, int *nodes);
/* The same of rods that rows of nodes [node_count] of the body hold, which their holds count by. */
NDLI_API void ndli_couple_prepare_rows(ndli_couple *couple, ndli_line *const *lines, int count, int max_trials,
                                       double *unknown, const int *nodes, int node_count);
/* After the solve: SB_ERROR_DIVERGED when its last friction states have no positive definite matrix, or when they were
 * not found in max_trials and what sticks is held by more than can hold it. */
NDLI_API sb_result ndli_couple_check(const ndli_couple *couple, sb_error *error);
#endif

#endif /* NDL_COUPLE_SOLVE_H */

/* ==== src/needle/couple_line.c ==== */
/* couple_line: see couple_line.h. */


#include <string.h>

/* ---- memory ---- */

static void ndli_line_layout(ndli_line *line, sbi_arena *arena)
{
    size_t n = (size_t)line->capacity;
    ndli_v3 **vectors[] = {&line->move, &line->contact, &line->reaction, &line->tangent,
                           &line->load, &line->before,  &line->motion,   &line->force};
    double **reals[] = {&line->friction, &line->viscous, &line->slip};
    for (size_t i = 0; i < sizeof vectors / sizeof *vectors; i++)
        *vectors[i] = (ndli_v3 *)sbi_arena_take(arena, n, sizeof(ndli_v3));
    for (size_t i = 0; i < sizeof reals / sizeof *reals; i++)
        *reals[i] = (double *)sbi_arena_take(arena, n, sizeof(double));
    line->band = (double *)sbi_arena_take(arena, n, NDLI_LINE_UNKNOWNS * (NDLI_LINE_WIDTH + 1) * sizeof(double));
    line->right = (double *)sbi_arena_take(arena, n, NDLI_LINE_UNKNOWNS * sizeof(double));
    line->state = (unsigned char *)sbi_arena_take(arena, n, 1);
}

NDLI_API int ndli_line_create(ndli_line *line, ndl_rod *rod, const sb_allocator *allocator)
{
    sbi_arena arena = {NULL, 0, 0};
    memset(line, 0, sizeof *line);
    line->rod = rod;
    line->capacity = rod->capacity;
    line->first = rod->node_count;
    line->allocator = *allocator;
    ndli_line_layout(line, &arena);
    line->memory = arena.overflow ? NULL : sbi_alloc_zeroed(allocator, 1, arena.used);
    if (!line->memory)
        return 0;
    arena.base = (unsigned char *)line->memory;
    arena.used = 0;
    ndli_line_layout(line, &arena);
    return 1;
}

NDLI_API void ndli_line_free(ndli_line *line)
{
    if (line->memory)
        sbi_free(&line->allocator, line->memory);
    memset(line, 0, sizeof *line);
}

/* ---- the rod's rows ---- */

static int ndli_line_is_coupled(const ndli_line *line, int i)
{
    return i >= line->first && i < line->first + ndli_line_taken_count(line);
}

/* Along which a node may slip: between its edges, at the tip the last one. */
static void ndli_line_set_tangents(ndli_line *line)
{
    const ndl_rod *rod = line->rod;
    int last = rod->node_count - 1;
    for (int i = 0; i <= last; i++) {
        ndli_v3 t = rod->shape.tangent[sbi_min_int(i, last - 1)];
        if (i > 0 && i < last)
            t = ndli_add(t, rod->shape.tangent[i - 1]);
        line->tangent[i] = ndli_scale(1 / ndli_norm(t), t);
    }
}

/* force = H motion, by the lower half of H. */
static void ndli_line_press(const ndli_line *line, const ndli_v3 *motion, ndli_v3 *force)
{
    for (int i = 0; i < line->rod->node_count; i++) {
        const ndli_m3 *row = line->rod->matrix.node[i];
        force[i] = ndli_m_apply(&row[0], motion[i]);
        for (int k = 1; k <= 2 && k <= i; k++) {
            force[i] = ndli_add(force[i], ndli_m_apply(&row[k], motion[i - k]));
            force[i - k] = ndli_add(force[i - k], ndli_m_tapply(&row[k], motion[i]));
        }
    }
}

/* H = M/dt^2 + C/dt + K with its elastic part safe: positive definite. */
static void ndli_line_set_matrix(ndli_line *line)
{
    ndl_rod *rod = line->rod;
    ndli_rod_derivatives(rod, NDLI_ROD_NO_TWIST, rod->gradient, rod->turn_gradient, &rod->matrix);
    ndli_rod_set_damping_shape(rod);
    ndli_rod_add_damping_matrix(rod, 1 / line->dt, &rod->matrix);
    for (int i = 0; i < rod->node_count; i++)
        ndli_m_add_identity(&rod->matrix.node[i][0], rod->mass[i] / (line->dt * line->dt));
}

NDLI_API int ndli_line_linearise(ndli_line *line, const sbi_guest_step *step)
{
    ndl_rod *rod = line->rod;
    int bad = ndli_rod_set_shape(rod, rod->x, rod->theta);
    if (bad >= 0)
        return bad;
    line->dt = step->dt;
    line->level = step->level;
    ndli_line_set_tangents(line);
    ndli_line_set_matrix(line);
    for (int i = 0; i < rod->node_count; i++) {
        ndli_v3 load = ndli_madd(rod->force[i], rod->mass[i], ndli_madd(rod->gravity, 1 / line->dt, rod->v[i]));
        line->load[i] = ndli_sub(load, rod->gradient[i]);
    }
    return -1;
}

NDLI_API void ndli_line_keep_contact(ndli_line *line)
{
    memcpy(line->before, line->contact, (size_t)line->rod->node_count * sizeof *line->before);
}

NDLI_API void ndli_line_start(const ndli_line *line, double *unknown)
{
    const ndl_rod *rod = line->rod;
    for (int i = 0; i < rod->node_count; i++, unknown += NDLI_LINE_UNKNOWNS) {
        int moves = !rod->held[i] && !ndli_line_is_coupled(line, i);
        ndli_v3 way = moves ? ndli_scale(line->level * line->dt, rod->v[i]) : ndli_v(0, 0, 0);
        unknown[0] = way.x, unknown[1] = way.y, unknown[2] = way.z, unknown[3] = 0;
    }
}

static ndli_v3 ndli_line_at(const double *vectors, int stride, int i)
{
    const double *v = vectors + (size_t)stride * (size_t)i;
    return ndli_v(v[0], v[1], v[2]);
}

static void ndli_line_put(double *vectors, int stride, int i, ndli_v3 v)
{
    double *out = vectors + (size_t)stride * (size_t)i;
    out[0] = v.x, out[1] = v.y, out[2] = v.z;
}

/* How the rod's nodes move over the whole step by the unknowns, which are those at its level; held ones by `held` times
 * their way. */
static void ndli_line_expand(ndli_line *line, double held, const double *unknown, const double *nodes)
{
    const ndl_rod *rod = line->rod;
    for (int i = 0; i < rod->node_count; i++) {
        int coupled = ndli_line_is_coupled(line, i);
        ndli_v3 way = coupled ? ndli_line_at(nodes, 3, i - line->first) : ndli_line_at(unknown, NDLI_LINE_UNKNOWNS, i);
        if (coupled && ndli_line_is_slipping(line, i))
            way = ndli_madd(way, unknown[NDLI_LINE_UNKNOWNS * i + 3], line->tangent[i]);
        line->motion[i] =
            rod->held[i] ? ndli_scale(held, ndli_sub(rod->target[i], rod->x[i])) : ndli_scale(1 / line->level, way);
    }
}

NDLI_API void ndli_line_apply(ndli_line *line, int loads, const double *unknown, const double *nodes,
                              double *out_unknown, double *out_nodes)
{
    const ndl_rod *rod = line->rod;
    memset(out_unknown, 0, (size_t)ndli_line_unknown_count(line) * sizeof *out_unknown);
    ndli_line_expand(line, loads, unknown, nodes);
    ndli_line_press(line, line->motion, line->force);
    for (int i = 0; i < rod->node_count; i++) {
        int coupled = ndli_line_is_coupled(line, i), slips = coupled && ndli_line_is_slipping(line, i);
        ndli_v3 row = loads ? ndli_sub(line->load[i], line->force[i]) : line->force[i];
        double along = ndli_dot(line->tangent[i], row);
        if (slips) {
            double viscous = ndli_line_viscosity(line, i) * unknown[NDLI_LINE_UNKNOWNS * i + 3] / line->level;
            along += loads ? ndli_line_drag(line, i) - viscous : viscous;
            out_unknown[NDLI_LINE_UNKNOWNS * i + 3] = line->level * along;
        }
        row = ndli_scale(line->level, row);
        if (coupled)
            ndli_line_put(out_nodes, 3, i - line->first,
                          loads ? ndli_madd(row, line->level - 1, line->before[i]) : row);
        else if (!rod->held[i])
            ndli_line_put(out_unknown, NDLI_LINE_UNKNOWNS, i, row);
    }
}

/* ---- the rod's block ---- */

/* Displacements of node i by its unknowns: [first, along] (u or z, alpha). */
typedef struct ndli_line_map {
    int moves[3]; /* 1: the component is an unknown, */
    int slips;    /* 1: the fourth is */
    int node;     /* the body's node of the first three, or -1 */
    ndli_v3 along;
} ndli_line_map;

static ndli_line_map ndli_line_get_map(const ndli_line *line, int i)
{
    ndli_line_map map;
    int coupled = ndli_line_is_coupled(line, i);
    map.node = coupled ? line->path[i - line->first] : -1;
    for (int c = 0; c < 3; c++)
        map.moves[c] = coupled ? !(line->matrix->fixed[map.node] >> c & 1) : !line->rod->held[i];
    map.slips = coupled && ndli_line_is_slipping(line, i);
    map.along = line->tangent[i];
    return map;
}

/* out += the block of the body's matrix between the nodes of two rod nodes. */
static void ndli_line_add_body_block(const ndli_line *line, const ndli_line_map *a, const ndli_line_map *b,
                                     ndli_m3 *out)
{
    int place = a->node >= 0 && b->node >= 0 ? sb_matrix_find(line->matrix, a->node, b->node) : -1;
    for (int c = 0; place >= 0 && c < 9; c++)
        out->m[c / 3][c % 3] += (double)line->matrix->blocks[place][c];
}

/* Rows of node i against columns of node i - k: the rod's block seen through the maps, and the body's. */
static void ndli_line_block(const ndli_line *line, int i, int k, double out[NDLI_LINE_UNKNOWNS][NDLI_LINE_UNKNOWNS])
{
    ndli_line_map a = ndli_line_get_map(line, i), b = ndli_line_get_map(line, i - k);
    ndli_m3 h = ndli_m_zero(), both;
    ndli_v3 right, left;
    ndli_m_add(&h, 1, &line->rod->matrix.node[i][k]); /* forces count with the level, ways with its inverse */
    both = h;
    ndli_line_add_body_block(line, &a, &b, &both);
    right = ndli_m_apply(&h, b.along);
    left = ndli_m_tapply(&h, a.along);
    memset(out, 0, NDLI_LINE_UNKNOWNS * sizeof *out);
    for (int r = 0; r < 3; r++) {
        for (int c = 0; c < 3; c++)
            out[r][c] = a.moves[r] && b.moves[c] ? both.m[r][c] : 0;
        out[r][3] = a.moves[r] && b.slips ? ndli_component(right, r) : 0;
        out[3][r] = a.slips && b.moves[r] ? ndli_component(left, r) : 0;
    }
    out[3][3] = a.slips && b.slips ? ndli_dot(a.along, right) : 0;
    if (k == 0) {
        out[3][3] += a.slips ? ndli_line_viscosity(line, i) : 1;
        for (int r = 0; r < 3; r++)
            out[r][r] += a.moves[r] ? 0 : 1;
    }
}

enum { NDLI_LINE_STRIDE = NDLI_LINE_WIDTH + 1 };

/* Where row r of node a and column c of node b are in the band. */
static size_t ndli_line_band_at(int a, int r, int b, int c)
{
    int row = NDLI_LINE_UNKNOWNS * a + r, column = NDLI_LINE_UNKNOWNS * b + c;
    return (size_t)row * NDLI_LINE_STRIDE + (size_t)(column - row + NDLI_LINE_WIDTH);
}

NDLI_API void ndli_line_add_to_band(ndli_line *line, int a, int b, double factor, const ndli_m3 *k)
{
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3 && (a > b || c <= r); c++)
            line->band[ndli_line_band_at(a, r, b, c)] += factor * k->m[r][c];
}

NDLI_API void ndli_line_fill(ndli_line *line, const sb_matrix *matrix)
{
    enum { N = NDLI_LINE_UNKNOWNS };
    int n = N * line->rod->node_count;
    line->matrix = matrix;
    memset(line->band, 0, (size_t)n * NDLI_LINE_STRIDE * sizeof(double));
    for (int i = 0; i < line->rod->node_count; i++)
        for (int k = 0; k <= 2 && k <= i; k++) {
            double block[N][N];
            ndli_line_block(line, i, k, block);
            for (int r = 0; r < N; r++)
                for (int c = 0; c < N && (k > 0 || c <= r); c++)
                    line->band[ndli_line_band_at(i, r, i - k, c)] = block[r][c];
        }
}

NDLI_API int ndli_line_factor(ndli_line *line)
{
    return ndli_band_factor(line->band, ndli_line_unknown_count(line), NDLI_LINE_WIDTH, 1e-14) < 0;
}

NDLI_API void ndli_line_solve_block(ndli_line *line, const double *unknown, const double *nodes, double *out_unknown,
                                    double *out_nodes)
{
    double *right = line->right;
    size_t bytes = (size_t)ndli_line_unknown_count(line) * sizeof(double);
    memcpy(right, unknown, bytes);
    for (int k = 0; k < ndli_line_taken_count(line); k++)
        ndli_line_put(right, NDLI_LINE_UNKNOWNS, line->first + k, ndli_line_at(nodes, 3, k));
    ndli_band_solve(line->band, ndli_line_unknown_count(line), NDLI_LINE_WIDTH, right);
    memcpy(out_unknown, right, bytes);
    for (int k = 0; k < ndli_line_taken_count(line); k++) {
        ndli_line_put(out_nodes, 3, k, ndli_line_at(right, NDLI_LINE_UNKNOWNS, line->first + k));
        ndli_line_put(out_unknown, NDLI_LINE_UNKNOWNS, line->first + k, ndli_v(0, 0, 0));
    }
}

/* ---- results ---- */

NDLI_API void ndli_line_read(ndli_line *line, const double *unknown, const double *nodes)
{
    const ndl_rod *rod = line->rod;
    ndli_line_expand(line, 1, unknown, nodes);
    ndli_line_press(line, line->motion, line->force);
    for (int i = 0; i < rod->node_count; i++) {
        ndli_v3 balance = ndli_sub(line->force[i], line->load[i]), none = ndli_v(0, 0, 0);
        int coupled = ndli_line_is_coupled(line, i), slips = coupled && ndli_line_is_slipping(line, i);
        double slip = slips ? unknown[NDLI_LINE_UNKNOWNS * i + 3] / line->level : 0;
        if (slips) { /* its friction is known better than the rows' residual */
            double along = ndli_line_drag(line, i) - ndli_line_viscosity(line, i) * slip;
            balance = ndli_madd(balance, along - ndli_dot(line->tangent[i], balance), line->tangent[i]);
        }
        line->move[i] = line->motion[i];
        line->slip[i] = slip;
        line->contact[i] = coupled ? balance : none;
        line->reaction[i] = rod->held[i] ? balance : none;
    }
}

/* ==== src/needle/couple_rows.c ==== */
/* couple_rows: see couple_rows.h. */

/* Rod nodes of hold i, and their shares. */
typedef struct ndli_rows_ends {
    int count, node[2];
    double share[2];
} ndli_rows_ends;

static ndli_rows_ends ndli_rows_get_ends(const ndli_line *line, int i)
{
    double share = line->holds[i].share;
    ndli_rows_ends ends;
    ends.count = share > 0 ? 2 : 1;
    ends.node[0] = i, ends.node[1] = i + 1;
    ends.share[0] = 1 - share, ends.share[1] = share;
    return ends;
}

/* Past the tissue: what the rod's motion [nodes], over the whole step, and the nodes' add to s. */
static ndli_v3 ndli_rows_way(const ndli_line *line, int i, const double *nodes)
{
    const struct ndli_hold *hold = line->holds + i;
    ndli_rows_ends ends = ndli_rows_get_ends(line, i);
    ndli_v3 way = ndli_v(0, 0, 0);
    for (int e = 0; e < ends.count; e++)
        way = ndli_madd(way, ends.share[e], line->motion[ends.node[e]]);
    for (int a = 0; a < hold->count; a++) {
        const double *u = nodes + 3 * (size_t)hold->places[a];
        way = ndli_madd(way, -hold->weights[a] / line->level, ndli_v(u[0], u[1], u[2]));
    }
    return way;
}

/* Of what a hold's spring takes up, the share that slip does not, for its viscous friction: 1 without such. */
static double ndli_rows_give(const ndli_line *line, int i)
{
    double k = line->holds[i].along;
    return k > 0 ? k / (k + ndli_line_viscosity(line, i)) : 0;
}

/* Stiffness along (N/m) in the present state of friction: of a slipping hold that of viscous friction behind its
 * spring. */
static double ndli_rows_along(const ndli_line *line, int i)
{
    if (!ndli_line_is_slipping(line, i))
        return line->holds[i].along;
    return ndli_rows_give(line, i) * ndli_line_viscosity(line, i);
}

static ndli_v3 ndli_rows_spring(const ndli_line *line, int i, ndli_v3 s)
{
    const struct ndli_hold *hold = line->holds + i;
    double along = ndli_dot(hold->tangent, s);
    ndli_v3 across = ndli_madd(s, -along, hold->tangent);
    return ndli_madd(ndli_scale(-hold->across, across), -ndli_rows_along(line, i) * along, hold->tangent);
}

/* Force of the tissue on the rod (N) after a way. */
static ndli_v3 ndli_rows_force(const ndli_line *line, int i, ndli_v3 way)
{
    const struct ndli_hold *hold = line->holds + i;
    ndli_v3 force = ndli_rows_spring(line, i, ndli_add(hold->offset, way));
    if (hold->count == 0)
        return ndli_v(0, 0, 0);
    if (ndli_line_is_slipping(line, i))
        force = ndli_madd(force, ndli_rows_give(line, i) * ndli_line_drag(line, i), hold->tangent);
    return force;
}

NDLI_API void ndli_rows_apply(ndli_line *line, int loads, const double *nodes, double *out_unknown, double *out_nodes)
{
    for (int i = ndli_line_rearmost(line); i <= ndli_line_foremost(line); i++) {
        const struct ndli_hold *hold = line->holds + i;
        ndli_rows_ends ends = ndli_rows_get_ends(line, i);
        ndli_v3 way = ndli_rows_way(line, i, nodes), force, on_tissue;
        if (hold->count == 0)
            continue;
        force = ndli_scale(line->level,
                           loads ? ndli_rows_force(line, i, way) : ndli_scale(-1, ndli_rows_spring(line, i, way)));
        for (int e = 0; e < ends.count; e++)
            if (!line->rod->held[ends.node[e]])
                ndli_line_add_to(out_unknown, NDLI_LINE_UNKNOWNS, ends.node[e], ends.share[e], force);
        on_tissue = ndli_scale(-1, force);
        if (loads)
            on_tissue = ndli_madd(on_tissue, line->level - 1, line->before[i]);
        for (int a = 0; a < hold->count; a++)
            ndli_line_add_to(out_nodes, 3, hold->places[a], hold->weights[a], on_tissue);
    }
}

/* ---- the rod's block ---- */

static ndli_m3 ndli_rows_matrix(const ndli_line *line, int i)
{
    const struct ndli_hold *hold = line->holds + i;
    ndli_m3 k = ndli_m_zero();
    ndli_m_add_identity(&k, hold->across);
    ndli_m_add_outer(&k, ndli_rows_along(line, i) - hold->across, hold->tangent, hold->tangent);
    return k;
}

NDLI_API void ndli_rows_add_band(ndli_line *line)
{
    for (int i = ndli_line_rearmost(line); i <= ndli_line_foremost(line); i++) {
        ndli_rows_ends ends = ndli_rows_get_ends(line, i);
        ndli_m3 k = ndli_rows_matrix(line, i);
        for (int a = 0; a < ends.count && line->holds[i].count > 0; a++)
            for (int b = 0; b <= a; b++)
                if (!line->rod->held[ends.node[a]] && !line->rod->held[ends.node[b]])
                    ndli_line_add_to_band(line, ends.node[a], ends.node[b], ends.share[a] * ends.share[b], &k);
    }
}

/* ---- results ---- */

NDLI_API void ndli_rows_read(ndli_line *line, const double *nodes)
{
    for (int i = ndli_line_rearmost(line); i <= ndli_line_foremost(line); i++) {
        const struct ndli_hold *hold = line->holds + i;
        ndli_rows_ends ends = ndli_rows_get_ends(line, i);
        ndli_v3 way = ndli_rows_way(line, i, nodes), force = ndli_rows_force(line, i, way);
        double along = ndli_dot(hold->tangent, ndli_add(hold->offset, way));
        line->contact[i] = force;
        if (hold->count == 0) /* nothing is there: it goes on as the rod does */
            line->slip[i] = ndli_dot(hold->tangent, way);
        else if (ndli_line_is_slipping(line, i)) /* what the spring is wound by does not slip */
            line->slip[i] = along + ndli_dot(hold->tangent, force) / hold->along;
        for (int e = 0; e < ends.count; e++)
            if (line->rod->held[ends.node[e]])
                line->reaction[ends.node[e]] = ndli_madd(line->reaction[ends.node[e]], -ends.share[e], force);
    }
}

/* ==== src/needle/couple.c ==== */
/* couple: the friction states of a step. Friction does not depend on normal forces here (Tresca), so that a step is a
 * strictly convex problem with exactly one solution. States are guessed, the linear system solved, and every state that
 * the solution contradicts is turned over: block pivoting, with the last contradicted node alone (least index, which is
 * finite) while that makes no headway. */


#include <string.h>

/* ---- the lines' parts of the guest's vectors: all unknowns, then three components of each node ---- */

typedef struct ndli_couple_part {
    size_t unknown, nodes; /* where the line's begin */
} ndli_couple_part;

static ndli_couple_part ndli_couple_first(const ndli_couple *c)
{
    ndli_couple_part part;
    part.unknown = 0;
    part.nodes = (size_t)c->guest.unknown_count;
    return part;
}

static ndli_couple_part ndli_couple_next(const ndli_couple *c, ndli_couple_part part, int k)
{
    part.unknown += (size_t)ndli_line_unknown_count(c->lines[k]);
    part.nodes += 3 * (size_t)ndli_line_taken_count(c->lines[k]);
    return part;
}

static void ndli_couple_apply(const ndli_couple *c, int loads, const double *x, double *y)
{
    ndli_couple_part at = ndli_couple_first(c);
    if (c->rows)
        memset(y + at.nodes, 0, 3 * (size_t)c->guest.node_count * sizeof(double));
    for (int k = 0; k < c->count; at = ndli_couple_next(c, at, k), k++) {
        ndli_line_apply(c->lines[k], loads, x + at.unknown, x + at.nodes, y + at.unknown, y + at.nodes);
        if (c->rows)
            ndli_rows_apply(c->lines[k], loads, x + at.nodes, y + at.unknown, y + at.nodes);
    }
}

static void ndli_couple_residual(void *user, const double *x, double *y)
{
    ndli_couple_apply((const ndli_couple *)user, 1, x, y);
}

static void ndli_couple_multiply(void *user, const double *x, double *y)
{
    ndli_couple_apply((const ndli_couple *)user, 0, x, y);
}

static void ndli_couple_precondition(void *user, const double *r, double *z)
{
    const ndli_couple *c = (const ndli_couple *)user;
    ndli_couple_part at = ndli_couple_first(c);
    for (int k = 0; k < c->count; at = ndli_couple_next(c, at, k), k++)
        ndli_line_solve_block(c->lines[k], r + at.unknown, r + at.nodes, z + at.unknown, z + at.nodes);
}

static int ndli_couple_factor(const ndli_couple *c)
{
    for (int k = 0; k < c->count; k++) {
        ndli_line_fill(c->lines[k], c->matrix);
        if (c->rows)
            ndli_rows_add_band(c->lines[k]);
        if (!ndli_line_factor(c->lines[k]))
            return 0;
    }
    return 1;
}

/* The rods at their shape at the start of the step. */
static sb_result ndli_couple_linearise(const ndli_couple *c, const sbi_guest_step *step, sb_error *error)
{
    ndli_couple_part at = ndli_couple_first(c);
    for (int k = 0; k < c->count; at = ndli_couple_next(c, at, k), k++) {
        int bad = ndli_line_linearise(c->lines[k], step);
        if (bad >= 0)
            return sbi_fail_node(error, SB_ERROR_DIVERGED, bad, "needle %d is folded at its node %d", k, bad);
        ndli_line_start(c->lines[k], c->guest.unknown + at.unknown);
    }
    return SB_OK;
}

static sb_result ndli_couple_begin(void *user, const sbi_guest_step *step, sb_error *error)
{
    ndli_couple *c = (ndli_couple *)user;
    sb_result result = step->iteration == 0 ? ndli_couple_linearise(c, step, error) : SB_OK;
    c->trials = 1;
    c->fewest = 0x7fffffff;
    c->stalled = 0;
    if (result != SB_OK)
        return result;
    c->matrix = step->matrix;
    if (!ndli_couple_factor(c))
        return sbi_fail(error, SB_ERROR_INDEFINITE, "the needles' matrix is not positive definite");
    return SB_OK;
}

static void ndli_couple_read(const ndli_couple *c, const double *x)
{
    ndli_couple_part at = ndli_couple_first(c);
    for (int k = 0; k < c->count; at = ndli_couple_next(c, at, k), k++) {
        ndli_line_read(c->lines[k], x + at.unknown, x + at.nodes);
        if (c->rows)
            ndli_rows_read(c->lines[k], x + at.nodes);
    }
}

static void ndli_couple_commit(void *user, const double *x) { ndli_couple_read((const ndli_couple *)user, x); }

/* ---- friction states ---- */

/* The state that the solution asks for at a coupled node. */
static int ndli_couple_wanted(const ndli_line *line, int i)
{
    double along = ndli_dot(line->holds ? line->holds[i].tangent : line->tangent[i], line->contact[i]);
    if (ndli_line_is_slipping(line, i))
        return ndli_line_sign(line, i) * line->slip[i] >= 0 ? (int)line->state[i] : (int)NDL_STATIC;
    if (along < -ndli_line_limit(line, i, 1))
        return NDL_DYNAMIC_FORWARD;
    if (along > ndli_line_limit(line, i, -1))
        return NDL_DYNAMIC_BACKWARD;
    return NDL_STATIC;
}

static int ndli_couple_count_wrong(const ndli_couple *c, const double *x)
{
    int wrong = 0;
    ndli_couple_read(c, x);
    for (int k = 0; k < c->count; k++)
        for (int i = ndli_line_rearmost(c->lines[k]); i <= ndli_line_foremost(c->lines[k]); i++)
            wrong += ndli_couple_wanted(c->lines[k], i) != c->lines[k]->state[i];
    return wrong;
}

/* Turns over what the solution contradicts: all, or the last only. */
static void ndli_couple_flip(const ndli_couple *c, int all)
{
    for (int k = c->count - 1; k >= 0; k--)
        for (int i = ndli_line_foremost(c->lines[k]); i >= ndli_line_rearmost(c->lines[k]); i--) {
            int wanted = ndli_couple_wanted(c->lines[k], i);
            if (wanted == c->lines[k]->state[i])
                continue;
            c->lines[k]->state[i] = (unsigned char)wanted;
            if (!all)
                return;
        }
}

/* Nodes that stick have no slip. */
static void ndli_couple_stop(const ndli_couple *c)
{
    ndli_couple_part at = ndli_couple_first(c);
    for (int k = 0; k < c->count; at = ndli_couple_next(c, at, k), k++)
        for (int i = 0; i < c->lines[k]->rod->node_count; i++)
            if (!ndli_line_is_slipping(c->lines[k], i))
                c->guest.unknown[at.unknown + NDLI_LINE_UNKNOWNS * (size_t)i + 3] = 0;
}

/* 1: states have changed, and the solve goes on. */
static int ndli_couple_settle(void *user, const double *x)
{
    ndli_couple *c = (ndli_couple *)user;
    int wrong = ndli_couple_count_wrong(c, x);
    c->info.consistent = !wrong;
    if (!wrong || c->trials >= c->max_trials)
        return 0;
    c->stalled = wrong < c->fewest ? 0 : c->stalled + 1;
    c->fewest = sbi_min_int(c->fewest, wrong);
    ndli_couple_flip(c, c->stalled < 3);
    ndli_couple_stop(c);
    c->trials++;
    c->info.trials = sbi_max_int(c->info.trials, c->trials);
    c->indefinite = !ndli_couple_factor(c);
    return !c->indefinite;
}

/* ---- the guest ---- */

static void ndli_couple_set_up(ndli_couple *couple, ndli_line *const *lines, int count, int max_trials, double *unknown)
{
    memset(couple, 0, sizeof *couple);
    couple->lines = lines;
    couple->count = count;
    couple->max_trials = max_trials;
    couple->info.trials = 1;
    couple->guest.user = couple;
    couple->guest.unknown = unknown;
    for (int k = 0; k < count; k++) {
        couple->guest.unknown_count += ndli_line_unknown_count(lines[k]);
        ndli_line_keep_contact(lines[k]);
    }
    couple->guest.residual = ndli_couple_residual;
    couple->guest.multiply = ndli_couple_multiply;
    couple->guest.precondition = ndli_couple_precondition;
    couple->guest.begin = ndli_couple_begin;
    couple->guest.settle = ndli_couple_settle;
    couple->guest.commit = ndli_couple_commit;
}

NDLI_API void ndli_couple_prepare(ndli_couple *couple, ndli_line *const *lines, int count, int max_trials,
                                  double *unknown, int *nodes)
{
    ndli_couple_set_up(couple, lines, count, max_trials, unknown);
    for (int k = 0; k < count; k++)
        for (int i = 0; i < lines[k]->count; i++)
            nodes[couple->guest.node_count++] = lines[k]->path[i];
    couple->guest.nodes = nodes;
    couple->guest.taken_count = couple->guest.node_count;
}

NDLI_API void ndli_couple_prepare_rows(ndli_couple *couple, ndli_line *const *lines, int count, int max_trials,
                                       double *unknown, const int *nodes, int node_count)
{
    ndli_couple_set_up(couple, lines, count, max_trials, unknown);
    couple->rows = 1;
    couple->guest.nodes = nodes;
    couple->guest.node_count = node_count;
}

/* More than its law allows (N), summed over a needle's nodes that stick; what slips has its limit. *law: all that
 * friction and tip can hold. */
static double ndli_couple_excess(const ndli_line *line, double *law)
{
    double sum = 0;
    *law = 0;
    for (int i = ndli_line_rearmost(line); i <= ndli_line_foremost(line); i++) {
        double along = ndli_dot(line->holds ? line->holds[i].tangent : line->tangent[i], line->contact[i]);
        double most = ndli_line_limit(line, i, along < 0 ? 1 : -1);
        *law += most;
        if (!ndli_line_is_slipping(line, i))
            sum += fmax(0, fabs(along) - most);
    }
    return sum;
}

/* Of the law: what states that were not found to the end may be beyond it. */
static const double ndli_couple_most_excess = 0.02;

NDLI_API sb_result ndli_couple_check(const ndli_couple *couple, sb_error *error)
{
    for (int k = 0; k < couple->count && !couple->info.consistent; k++) {
        double law, excess = ndli_couple_excess(couple->lines[k], &law);
        if (excess > ndli_couple_most_excess * law)
            return sbi_fail(error, SB_ERROR_DIVERGED,
                            "needle %d: after %d trials its friction is %g N beyond the %g N that the tissue can hold",
                            k, couple->info.trials, excess, law);
    }
    if (couple->indefinite)
        return sbi_fail(error, SB_ERROR_DIVERGED, "the needles' matrix is not positive definite");
    return SB_OK;
}

/* ==== src/needle/bed.h ==== */
/* bed: a body of any elements, cut or not, as a needle sees it that is held by rows of weights. Floor 6, internal.
 *
 * A place is a material point: an element of the mesh that the body had when its first needle was made, or, where it
 * had been cut and what knows its pieces is there, before that, and coordinates in it. Where a blade has cut that
 * element since, the place is in the piece that has its material. */
#ifndef NDL_BED_H
#define NDL_BED_H


typedef struct ndli_place {
    int element; /* -1: none */
    sb_real xi[3];
} ndli_place;

/* What a place moves with. */
typedef struct ndli_bed_row {
    int cell, count;
    int nodes[SB_MAX_ELEMENT_NODES];
    double weights[SB_MAX_ELEMENT_NODES]; /* sum to 1 */
} ndli_bed_row;

typedef struct ndli_bed {
    sb_body *body;
    sb_allocator allocator;
    sb_mesh mesh; /* at rest */
    int *cells;   /* [elements] of the body */
    sbi_embed_volume volume;
    double mean_edge; /* m */
    int was_cut;      /* 1: when this was made */
    int version;      /* of the body's mesh, then */
    uint64_t hash;    /* of what it is made from: cells, their nodes and where these are */
    int is_lost;      /* 1: others than an sb_cut have changed the body's mesh since */
} ndli_bed;

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* From the mesh of `mesh_of`, which the body has, or will have; uncut 1: from that before any cut, which the body knows
 * (sbi_body_has_uncut). */
NDLI_API sb_result ndli_bed_create(sb_body *body, const sb_body *mesh_of, int uncut, const sb_allocator *allocator,
                                   ndli_bed *bed, sb_error *error);
/* It becomes `next`, which is zeros then. */
NDLI_API void ndli_bed_replace(ndli_bed *bed, ndli_bed *next);
NDLI_API void ndli_bed_free(ndli_bed *bed); /* safe on zeros */

/* Where X (m, at rest) is; `hint` is an element to start from. 0: outside, and *place is the nearest. */
NDLI_API int ndli_bed_locate(const ndli_bed *bed, sb_vec3 X, int hint, ndli_place *place);
/* 0: its material has been taken away. */
NDLI_API int ndli_bed_row_at(const ndli_bed *bed, const ndli_place *place, ndli_bed_row *row);
/* Both at once; *row has no nodes where there is no material: outside, by more than rounding, or taken away. */
NDLI_API int ndli_bed_find(const ndli_bed *bed, sb_vec3 X, int hint, ndli_place *place, ndli_bed_row *row);
NDLI_API ndli_v3 ndli_bed_at(const ndli_bed *bed, const ndli_bed_row *row); /* m, in space */
/* Deformation gradient. */
NDLI_API sb_mat3 ndli_bed_gradient(const ndli_bed *bed, const ndli_place *place, const ndli_bed_row *row);
NDLI_API int ndli_bed_region(const ndli_bed *bed, const ndli_bed_row *row);
/* Edge of a regular tet of the element's size (m). */
NDLI_API double ndli_bed_edge(const ndli_bed *bed, int element);
/* 1: x is in it, as it is now. O(faces). */
NDLI_API int ndli_bed_holds_in_space(const ndli_bed *bed, sb_vec3 x);
/* Where a segment first comes in through the skin, from outside in space, or through where it was before it was taken
 * away; *at: there (m). 0: nowhere. O(faces): for needles that are not in yet. */
NDLI_API int ndli_bed_hit(const ndli_bed *bed, sb_vec3 from, sb_vec3 to, ndli_place *place, sb_vec3 *at);
#endif

#endif /* NDL_BED_H */

/* ==== src/needle/bed.c ==== */
/* bed: see bed.h. */

#include <string.h>


/* ---- creation ---- */

static uint64_t ndli_bed_hash(const ndli_bed *bed)
{
    size_t elements = (size_t)bed->mesh.element_count, corners = elements * (size_t)sb_mesh_element_width(&bed->mesh);
    uint64_t hash = ndli_image_hash(elements, bed->cells, elements * sizeof(int));
    hash = ndli_image_hash(hash, bed->mesh.elements, corners * sizeof(int));
    for (size_t i = 0; i < corners; i++)
        hash = ndli_image_hash(hash, bed->mesh.nodes + bed->mesh.elements[i], sizeof(sb_vec3));
    return hash;
}

/* Faces of tets are equilateral triangles where the mesh is even, those of hexes squares. */
static double ndli_bed_edge_of(const ndli_bed *bed, double volume)
{
    return cbrt(bed->volume.is_box ? volume : 6 * sqrt(2.0) * volume);
}

/* The mesh that there is, and which cells its elements are. */
static sb_result ndli_bed_copy_mesh(ndli_bed *bed, const sb_body *mesh_of, sb_error *error)
{
    sb_result result = sbi_body_copy_mesh(mesh_of, &bed->allocator, &bed->mesh, error);
    if (result != SB_OK)
        return result;
    bed->was_cut = sbi_body_has_pieces(mesh_of);
    bed->cells = (int *)sbi_alloc(&bed->allocator, (size_t)bed->mesh.element_count, sizeof(int));
    if (!bed->cells)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a body's needles");
    sbi_body_list_cells(mesh_of, bed->cells);
    return SB_OK;
}

NDLI_API sb_result ndli_bed_create(sb_body *body, const sb_body *mesh_of, int uncut, const sb_allocator *allocator,
                                   ndli_bed *bed, sb_error *error)
{
    sb_result result;
    memset(bed, 0, sizeof *bed);
    bed->body = body;
    bed->allocator = *allocator;
    bed->version = sb_body_mesh_version(mesh_of);
    if (sbi_body_mesh(mesh_of).element_type == SB_CUSTOM)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "needles do not go into elements of your own (SB_CUSTOM)");
    result = uncut ? sbi_body_copy_uncut(mesh_of, body, allocator, &bed->mesh, &bed->cells, error)
                   : ndli_bed_copy_mesh(bed, mesh_of, error);
    if (result == SB_OK)
        result = sbi_embed_volume_create(&bed->mesh, SBI_EMBED_SKIN, allocator, &bed->volume, error);
    if (result != SB_OK)
        memset(&bed->volume, 0, sizeof bed->volume); /* it has been freed */
    if (result != SB_OK) {
        ndli_bed_free(bed);
        return result;
    }
    bed->hash = ndli_bed_hash(bed);
    bed->mean_edge = ndli_bed_edge_of(bed, (double)sb_mesh_volume(&bed->mesh) / bed->mesh.element_count);
    return SB_OK;
}

NDLI_API void ndli_bed_free(ndli_bed *bed)
{
    if (bed->volume.mesh)
        sbi_embed_volume_free(&bed->volume);
    if (bed->cells)
        sbi_free(&bed->allocator, bed->cells);
    sb_mesh_free(&bed->mesh);
    memset(bed, 0, sizeof *bed);
}

NDLI_API void ndli_bed_replace(ndli_bed *bed, ndli_bed *next)
{
    ndli_bed_free(bed);
    *bed = *next;
    bed->volume.mesh = &bed->mesh;
    memset(next, 0, sizeof *next);
}

/* ---- places ---- */

/* Lengths below this are rounding (m). */
static double ndli_bed_rounding(const ndli_bed *bed) { return 1e-3 * bed->mean_edge; }

/* The nearest place of the mesh; returns how far off it is (m). */
static double ndli_bed_closest(const ndli_bed *bed, sb_vec3 X, int hint, ndli_place *place)
{
    sbi_embed_hit hit;
    sbi_embed_closest(&bed->volume, X, sbi_min_int(hint, bed->mesh.element_count - 1), &hit);
    place->element = hit.element;
    memcpy(place->xi, hit.xi, sizeof place->xi);
    return hit.distance2 > 0 ? sqrt((double)hit.distance2) : 0;
}

NDLI_API int ndli_bed_locate(const ndli_bed *bed, sb_vec3 X, int hint, ndli_place *place)
{
    return !(ndli_bed_closest(bed, X, hint, place) > 0);
}

/* The cell with its material; -1: it has been taken away. */
static int ndli_bed_holder(const ndli_bed *bed, const ndli_place *place)
{
    int element = place->element;
    return sbi_body_find_holder(bed->body, &bed->mesh, element, bed->cells[element], place->xi);
}

/* 1: the row is of the place's material. A cell whose material was taken away leaves its slot to others. */
static int ndli_bed_is_row_of(const ndli_bed *bed, const ndli_place *place, const ndli_bed_row *row)
{
    const int *nodes = bed->mesh.elements + (size_t)place->element * (size_t)row->count;
    const sb_vec3 *X = sb_body_rest_positions(bed->body);
    ndli_v3 gap = ndli_v(0, 0, 0);
    for (int a = 0; a < row->count; a++)
        gap = ndli_madd(gap, row->weights[a], ndli_from(sb_v3_sub(X[row->nodes[a]], bed->mesh.nodes[nodes[a]])));
    return ndli_norm(gap) < ndli_bed_rounding(bed);
}

NDLI_API int ndli_bed_row_at(const ndli_bed *bed, const ndli_place *place, ndli_bed_row *row)
{
    sb_mesh mesh = sbi_body_mesh(bed->body);
    sb_real shape[SB_MAX_ELEMENT_NODES];
    const int *nodes;
    row->cell = ndli_bed_holder(bed, place);
    row->count = sb_mesh_element_width(&mesh);
    if (row->cell < 0 || !sb_body_cell_in_use(bed->body, row->cell))
        return 0;
    nodes = mesh.elements + (size_t)row->cell * (size_t)row->count;
    sb_element_shape(mesh.element_type, place->xi, shape, NULL);
    for (int a = 0; a < row->count; a++) {
        row->nodes[a] = nodes[a];
        row->weights[a] = (double)shape[a];
    }
    return ndli_bed_is_row_of(bed, place, row);
}

NDLI_API int ndli_bed_find(const ndli_bed *bed, sb_vec3 X, int hint, ndli_place *place, ndli_bed_row *row)
{
    if (!(ndli_bed_closest(bed, X, hint, place) > ndli_bed_rounding(bed)) && ndli_bed_row_at(bed, place, row))
        return 1;
    row->count = 0;
    return 0;
}

NDLI_API ndli_v3 ndli_bed_at(const ndli_bed *bed, const ndli_bed_row *row)
{
    const sb_vec3 *x = sb_body_positions(bed->body);
    ndli_v3 sum = ndli_v(0, 0, 0);
    for (int a = 0; a < row->count; a++)
        sum = ndli_madd(sum, row->weights[a], ndli_from(x[row->nodes[a]]));
    return sum;
}

NDLI_API sb_mat3 ndli_bed_gradient(const ndli_bed *bed, const ndli_place *place, const ndli_bed_row *row)
{
    const sb_vec3 *x = sb_body_positions(bed->body), *X = sb_body_rest_positions(bed->body);
    sb_real gradient[SB_MAX_ELEMENT_NODES][3];
    sb_mat3 now = sb_m3_zero(), rest = sb_m3_zero();
    sb_element_shape(bed->mesh.element_type, place->xi, NULL, gradient);
    for (int a = 0; a < row->count; a++) {
        sb_vec3 g = sb_v3(gradient[a][0], gradient[a][1], gradient[a][2]);
        now = sb_m3_add(now, sb_m3_outer(x[row->nodes[a]], g));
        rest = sb_m3_add(rest, sb_m3_outer(X[row->nodes[a]], g));
    }
    return sb_m3_mul(now, sb_m3_inverse(rest));
}

NDLI_API int ndli_bed_region(const ndli_bed *bed, const ndli_bed_row *row)
{
    return sbi_body_cell_region(bed->body, row->cell);
}

NDLI_API double ndli_bed_edge(const ndli_bed *bed, int element)
{
    return ndli_bed_edge_of(bed, fabs((double)sb_mesh_element_volume(&bed->mesh, element)));
}

/* ---- the skin ---- */

/* Where the segment comes in through a triangle, as a share of it; < 0: not. w: weights of the corners. */
static sb_real ndli_bed_cross(sb_vec3 from, sb_vec3 way, const sb_vec3 x[3], sb_real w[3])
{
    sb_vec3 ab = sb_v3_sub(x[1], x[0]), ac = sb_v3_sub(x[2], x[0]), n = sb_v3_cross(ab, ac);
    sb_vec3 to = sb_v3_sub(from, x[0]), q = sb_v3_cross(to, way);
    sb_real det = -sb_v3_dot(way, n), along;
    if (!(det > 0))
        return -1;
    w[1] = sb_v3_dot(ac, q) / det;
    w[2] = -sb_v3_dot(ab, q) / det;
    w[0] = 1 - w[1] - w[2];
    along = sb_v3_dot(to, n) / det;
    return w[0] >= 0 && w[1] >= 0 && w[2] >= 0 && along >= 0 && along <= 1 ? along : -1;
}

/* A triangle of a boundary face: local nodes of its corners in the face's element. */
typedef struct ndli_bed_triangle {
    int element, corners[3];
} ndli_bed_triangle;

static ndli_bed_triangle ndli_bed_triangle_of(const ndli_bed *bed, int face, int part)
{
    ndli_bed_triangle t;
    int local[SB_MAX_FACE_NODES];
    sb_element_type type;
    t.element = bed->volume.boundary.elements[face];
    sb_element_face(bed->mesh.element_type, bed->volume.boundary.faces[face], local, &type);
    for (int k = 0; k < 3; k++)
        t.corners[k] = local[k == 0 ? 0 : part + k];
    return t;
}

/* Nodes of the body, of a cell, and of an element as it was at first. */
static const int *ndli_bed_nodes_of(const ndli_bed *bed, int cell)
{
    sb_mesh mesh = sbi_body_mesh(bed->body);
    return mesh.elements + (size_t)cell * (size_t)sb_mesh_element_width(&mesh);
}
static const int *ndli_bed_first_nodes(const ndli_bed *bed, int element)
{
    return bed->mesh.elements + (size_t)element * (size_t)sb_mesh_element_width(&bed->mesh);
}

/* Where the segment comes in through the triangle as its element has it with these nodes; the place is straight between
 * the corners. < 0: not. */
static sb_real ndli_bed_cross_nodes(const ndli_bed *bed, const ndli_bed_triangle *t, const int *nodes, sb_vec3 from,
                                    sb_vec3 way, ndli_place *place)
{
    const sb_vec3 *x = sb_body_positions(bed->body);
    const int *rest = ndli_bed_first_nodes(bed, t->element);
    sb_vec3 corners[3], X = {0, 0, 0};
    sb_real w[3], along;
    for (int k = 0; k < 3; k++)
        corners[k] = x[nodes[t->corners[k]]];
    along = ndli_bed_cross(from, way, corners, w);
    if (along < 0)
        return -1;
    for (int k = 0; k < 3; k++)
        X = sb_v3_madd(X, w[k], bed->mesh.nodes[rest[t->corners[k]]]);
    (void)ndli_bed_locate(bed, X, t->element, place);
    return along;
}

/* Of an element that is cut each piece has only that part of the face that has its material. */
static sb_real ndli_bed_cross_kept(const ndli_bed *bed, const ndli_bed_triangle *t, sb_vec3 from, sb_vec3 way,
                                   ndli_place *place)
{
    int cell = bed->cells[t->element], holder;
    sb_real along = ndli_bed_cross_nodes(bed, t, ndli_bed_nodes_of(bed, cell), from, way, place);
    if (along < 0)
        return -1;
    holder = ndli_bed_holder(bed, place);
    if (holder != cell && !bed->was_cut && holder >= 0) { /* one that was cut before has each piece's own triangles */
        along = ndli_bed_cross_nodes(bed, t, ndli_bed_nodes_of(bed, holder), from, way, place);
        cell = holder;
        holder = along < 0 ? -1 : ndli_bed_holder(bed, place);
    }
    return holder == cell && sb_body_cell_in_use(bed->body, cell) ? along : -1;
}

/* Where skin has been taken away, a hole's mouth is. */
static sb_real ndli_bed_cross_skin(const ndli_bed *bed, const ndli_bed_triangle *t, sb_vec3 from, sb_vec3 way,
                                   ndli_place *place)
{
    sb_real along = ndli_bed_cross_kept(bed, t, from, way, place);
    if (along >= 0)
        return along;
    along = ndli_bed_cross_nodes(bed, t, ndli_bed_first_nodes(bed, t->element), from, way, place);
    return along >= 0 && ndli_bed_holder(bed, place) < 0 ? along : -1;
}

NDLI_API int ndli_bed_hit(const ndli_bed *bed, sb_vec3 from, sb_vec3 to, ndli_place *place, sb_vec3 *at)
{
    sb_vec3 way = sb_v3_sub(to, from);
    sb_real nearest = 2;
    for (int f = 0; f < bed->volume.boundary.surface.element_count; f++)
        for (int part = 0; part < bed->volume.face.corners - 2; part++) {
            ndli_bed_triangle t = ndli_bed_triangle_of(bed, f, part);
            ndli_place here;
            sb_real along = ndli_bed_cross_skin(bed, &t, from, way, &here);
            if (along < 0 || !(along < nearest))
                continue;
            nearest = along;
            *place = here;
        }
    *at = sb_v3_madd(from, nearest, way);
    return nearest <= 1;
}

NDLI_API int ndli_bed_holds_in_space(const ndli_bed *bed, sb_vec3 x)
{
    const sb_vec3 *nodes = sb_body_positions(bed->body);
    sb_vec3 far_off;
    sb_real size = (sb_real)bed->mean_edge;
    int layers = 0;
    for (int i = 0; i < sb_body_node_count(bed->body); i++)
        size = sb_max(size, sb_v3_norm(sb_v3_sub(nodes[i], x)));
    far_off = sb_v3_madd(x, 2 * size, sb_v3((sb_real)0.793, (sb_real)0.471, (sb_real)0.387)); /* along no edges */
    for (int f = 0; f < bed->volume.boundary.surface.element_count; f++)
        for (int part = 0; part < bed->volume.face.corners - 2; part++) {
            ndli_bed_triangle t = ndli_bed_triangle_of(bed, f, part);
            ndli_place place;
            layers += ndli_bed_cross_skin(bed, &t, far_off, sb_v3_sub(x, far_off), &place) >= 0;
            layers -= ndli_bed_cross_skin(bed, &t, x, sb_v3_sub(far_off, x), &place) >= 0;
        }
    return layers > 0;
}

/* ==== src/needle/track.h ==== */
/* track: the way that a tip has cut, a polyline of material points. Floor 6, internal. */
#ifndef NDL_TRACK_H
#define NDL_TRACK_H


typedef struct ndli_track {
    int count, capacity;
    double spacing; /* m: points are farther apart, but for the last */
    ndli_v3 *X;     /* [capacity] m at rest; borrowed, as what follows */
    double *arc;    /* [capacity] m from the skin, at rest */
    int *elements;  /* [capacity] where they are, to start a search from */
} ndli_track;

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
typedef struct ndli_track_point {
    ndli_v3 X, tangent; /* unit; 0 of a track of one point */
    int element;
} ndli_track_point;

SB_INLINE double ndli_track_length(const ndli_track *track) { return track->count ? track->arc[track->count - 1] : 0; }
NDLI_API void ndli_track_begin(ndli_track *track, ndli_v3 X, int element);
/* Goes on to X; 0: it has no room. */
NDLI_API int ndli_track_extend(ndli_track *track, ndli_v3 X, int element);
/* Ends it at arc, >= 0. */
NDLI_API void ndli_track_shorten(ndli_track *track, double arc);
/* Of a track of a point or more; beyond its ends: the end, with the tangent there. */
NDLI_API ndli_track_point ndli_track_at(const ndli_track *track, double arc);
#endif

#endif /* NDL_TRACK_H */

/* ==== src/needle/track.c ==== */
/* track: see track.h. */

static void ndli_track_put(ndli_track *track, int k, ndli_v3 X, int element)
{
    track->X[k] = X;
    track->elements[k] = element;
    track->arc[k] = k ? track->arc[k - 1] + ndli_norm(ndli_sub(X, track->X[k - 1])) : 0;
    track->count = k + 1;
}

/* Pieces are longer than this (m). */
static double ndli_track_least(const ndli_track *track) { return 1e-9 * track->spacing; }

NDLI_API void ndli_track_begin(ndli_track *track, ndli_v3 X, int element) { ndli_track_put(track, 0, X, element); }

NDLI_API int ndli_track_extend(ndli_track *track, ndli_v3 X, int element)
{
    int last = track->count - 1;
    int moves = last > 0 && ndli_norm(ndli_sub(X, track->X[last - 1])) < track->spacing;
    if (!(ndli_norm(ndli_sub(X, track->X[moves ? last - 1 : last])) > ndli_track_least(track)))
        return 1;
    if (!moves && track->count == track->capacity)
        return 0;
    ndli_track_put(track, moves ? last : track->count, X, element);
    return 1;
}

/* The last point not beyond arc that has another behind it. */
static int ndli_track_piece(const ndli_track *track, double arc)
{
    int low = 0, high = track->count - 1;
    while (high - low > 1) {
        int middle = low + (high - low) / 2;
        if (track->arc[middle] <= arc)
            low = middle;
        else
            high = middle;
    }
    return low;
}

NDLI_API ndli_track_point ndli_track_at(const ndli_track *track, double arc)
{
    ndli_track_point point;
    int k = ndli_track_piece(track, arc);
    double length, share;
    point.X = track->X[k];
    point.element = track->elements[k];
    point.tangent = ndli_v(0, 0, 0);
    if (track->count < 2)
        return point;
    length = track->arc[k + 1] - track->arc[k];
    share = length > 0 ? (arc - track->arc[k]) / length : 0;
    share = share < 0 ? 0 : share > 1 ? 1 : share;
    point.tangent = ndli_sub(track->X[k + 1], track->X[k]);
    point.X = ndli_madd(point.X, share, point.tangent);
    if (length > 0)
        point.tangent = ndli_scale(1 / length, point.tangent);
    return point;
}

NDLI_API void ndli_track_shorten(ndli_track *track, double arc)
{
    ndli_track_point end = ndli_track_at(track, arc);
    int k = ndli_track_piece(track, arc);
    if (!(arc < ndli_track_length(track)))
        return;
    track->count = k + 1;
    if (arc - track->arc[k] > ndli_track_least(track))
        ndli_track_put(track, k + 1, end.X, end.element);
}

/* ==== src/needle/needle_private.h ==== */
/* needle_private: what is inside a needle, and what the needles of a body share. Floor 6, internal: needle_site.c is
 * what they share, needle_read.c reads them, needle_sleeve.c feeds and turns them, needle_bevel.c bends their ways,
 * needle_membrane.c is membranes, needle_resist.c the tissue's resistance, needle_tip.c leads the remesher after the
 * tip, needle_nodes.c renews the rod's nodes, needle_undo.c takes a step back, needle_state.c saves and records them,
 * needle_step.c makes a step, needle.c makes and ends needles. */
#ifndef NDL_NEEDLE_PRIVATE_H
#define NDL_NEEDLE_PRIVATE_H


enum { NDLI_TRACK_POINTS = 16 }; /* of a needle's track for each of its nodes */

/* How a needle is in tissue that does not hold it. */
typedef enum ndli_lost {
    NDLI_LOST_NOT = 0,
    NDLI_LOST_MESH = 1, /* the mesh has changed about it, and it is not out of that yet */
    NDLI_LOST_TORN = 2  /* of needles held by rows: it has torn out, and is not out of the tissue yet */
} ndli_lost;

typedef struct ndli_capsule {
    ndl_membrane def;
    sb_surface *surface; /* the faces between its regions in the undeformed tissue */
} ndli_capsule;

struct ndl_needle {
    sb_allocator allocator;
    struct ndli_site *site; /* what it shares with the other needles of its body */
    int index;              /* number at the remesher */
    ndl_rod *rod;
    ndli_line line;
    ndl_bevel bevel;
    ndl_friction *frictions;
    int friction_count;
    ndli_capsule *capsules;
    int capsule_count;
    ndl_cutting cutting_at;
    void *cutting_user;
    int max_trials;
    sb_real entry_slip;
    double edge_length; /* m, of nodes outside */

    ndli_v3 outlet, axis;                             /* the sleeve: rod node 1, and where edge 0 looks */
    int base_given;                                   /* 1: the sleeve shall be at given_... at the end of the step */
    ndli_v3 given_outlet, given_axis, given_director; /* director 0: not asked for */

    double fed, advance; /* m */
    ndli_v3 heading;     /* unit vector in the material: where the path cut so far looks at the tip. The last edge is a
                          * chord of it, which lags behind by an angle that remeshing changes */
    ndli_v3 aside;       /* m in the material: of a shallow tip, how far its way has bent from the straight one */
    double wave;         /* m: length of the bends that the tissue makes of the shaft */
    ndli_v3 base_force, base_torque; /* N, N m about the outlet */
    int shallow;      /* 1: the tip is in the tissue, but less than about half an edge: only its entry has a node
                       * there. Tets between such a tip and the skin would be flat */
    int *path;        /* [capacity] tissue nodes of rod nodes line.first .. */
    ndli_v3 *gap;     /* [capacity] m: how far rod nodes are from these, with which they move: the mesh may not be
                       * able to have a node where the needle is, and a shaft that were drawn to it would make
                       * forces that no tissue makes */
    int enters;       /* in the present substep 1: its entry is new */
    int sinks;        /* and 1: its nodes below it are */
    int reaches;      /* and 1: its tip's node has come to where the tip is */
    ndli_v3 landing;  /* m: where the tip of one that sinks is in space */
    double radius;    /* m */
    ndli_track track; /* of a needle that is held by rows, as what follows */
    int lost;         /* an ndli_lost */
    double entering;  /* m of the edge before its first node in the tissue that are in it */
    double *arc;      /* [capacity] m at rest: where on it nodes in the tissue are */
    struct ndli_hold *holds; /* [capacity] the line's */
    double *stretch;         /* [capacity] of the tissue along it there, in the present substep */
    int pushed;              /* 1: the present substep's command takes the needle forward */
    int blocked, limited;    /* in the present step */
    int hold_steps;          /* substeps for which the tip is held because the remesher could not follow it */

    /* holds nothing between calls */
    ndli_v3 side;                     /* in which the bevel looked at the start of the substep */
    ndli_v3 *places, *place_tangents; /* [capacity] new nodes of the rod */
    ndli_v3 *old_contact;             /* [capacity] */
    int *old_path;                    /* [capacity] */
    ndli_v3 *old_gap;                 /* [capacity] */
    sb_vec3 *old_X;           /* [capacity] m: of the path's nodes before the mesh followed the tip, once it has */
    int follows;              /* 1: it has */
    unsigned char *old_state; /* [capacity] */
    void *memory;
};

/* Whose start a state is kept of. */
typedef enum ndli_keeping {
    NDLI_KEPT_STEP = 0,
    NDLI_KEPT_SUBSTEP = 1, /* one before which the mesh has changed in its step */
    NDLI_KEPT_COUNT = 2
} ndli_keeping;

/* A state of a body, its remesher and its needles in one block, which holds nothing between steps. */
typedef struct ndli_kept {
    unsigned char *bytes;
    size_t room, body;      /* bytes; those of the body's state at its begin */
    sbi_snapshot_held held; /* what that has from the step before */
} ndli_kept;

/* What the needles of one body share; made for the first, gone with the last. */
struct ndli_site {
    sb_body *body;
    sb_allocator allocator;
    int listener; /* its number at the body */
    int embeds;   /* 1: it has a bed, its needles are held by rows; 0: it has a remesher */
    ndli_bed bed;
    ndli_bed next_bed; /* of a state that is being loaded, where it is another */
    ndl_remesh *remesh;
    const ndli_topology *mesh;            /* the remesher's */
    ndl_needle *needles[NDL_MAX_NEEDLES]; /* by index; NULL: free */
    int count;
    double mean_edge; /* of the undeformed mesh (m) */
    int *coupled;     /* [coupled_room] nodes of the body that needles are on, of a solve */
    size_t coupled_room;
    int coupled_count; /* with a bed, as what follows */
    int *node_place;   /* [slots of nodes] their numbers in `coupled`, -1 between solves */
    size_t place_room;
    double *unknown; /* [NDLI_LINE_UNKNOWNS node_room] of a solve */
    size_t node_room;
    ndli_kept kept[NDLI_KEPT_COUNT]; /* states to go back to; see needle_undo.c */
    int undo_waits;                  /* 1: a failed step is still to be taken back, which wants memory */
};

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* ---- needle_site ---- */

/* Listens to changes of the body's mesh, if that can change. */
NDLI_API sb_result ndli_site_listen(struct ndli_site *site, sb_error *error);
NDLI_API void ndli_site_free(struct ndli_site *site);
NDLI_API double ndli_site_mean_edge(const ndli_topology *mesh); /* m */
/* Others have changed the mesh: needles are outside of it; and what is known of it is made anew. */
NDLI_API int ndli_site_is_stale(const struct ndli_site *site);
NDLI_API sb_result ndli_site_create_bed(const struct ndli_site *site, ndli_bed *bed, sb_error *error);
NDLI_API sb_result ndli_site_look(struct ndli_site *site, sb_error *error);
/* Once the body may have more nodes. 0: there is no memory. */
NDLI_API int ndli_site_reserve_places(struct ndli_site *site);
NDLI_API int ndli_site_free_index(const struct ndli_site *site);
/* Room for the nodes of all needles and so many more; 0: there is no memory. */
NDLI_API int ndli_site_reserve(struct ndli_site *site, int more);

/* ---- needle_read ---- */

/* What a region does to a needle, or NULL. */
NDLI_API const ndl_friction *ndli_needle_friction(const ndl_needle *needle, int region);

/* ---- needle_sleeve ---- */

/* Targets of the nodes in the sleeve, turn and feed of a substep of dt, which is `share` of what is left of the step.
 */
NDLI_API void ndli_needle_aim(ndl_needle *needle, const ndl_command *command, double dt, double share);
/* How far the base's m1, carried with its edge to `axis`, is from the given director (rad). */
NDLI_API double ndli_needle_given_turn(const ndl_needle *needle, ndli_v3 axis);

/* ---- needle_bevel ---- */

NDLI_API double ndli_bevel_curvature(const ndl_bevel *bevel); /* 1/m, of a way in rigid tissue */
/* Before a substep: from where its bevel turns. */
NDLI_API void ndli_bevel_begin(ndl_needle *needle);
/* 1: a needle that its mesh follows is bent by more than soft tissue holds; how far depends on the mesh. */
NDLI_API int ndli_bevel_is_coarse(const ndl_needle *needle);
NDLI_API double ndli_bevel_lag(const ndl_bevel *bevel); /* rad: how far a way may be from the shaft's direction */
/* Direction of the shaft at its tip (unit). heading: of the way; chord: of what is cut along the shaft's last edge. */
NDLI_API ndli_v3 ndli_bevel_shaft(const ndl_needle *needle, ndli_v3 heading, ndli_v3 chord);
/* After a substep: *heading (unit, in space) turns as the tip advances (m, > 0), but stays within `lag` (rad) of the
 * shaft; returns the tip's way. */
NDLI_API ndli_v3 ndli_bevel_go(const ndl_needle *needle, double advance, ndli_v3 shaft, double lag, ndli_v3 *heading);

/* ---- needle_held: of needles that are held by rows ---- */

/* Makes the holds, and what the tissue does at them; their nodes are listed at the site. */
NDLI_API void ndli_held_resist(ndl_needle *needle);
/* The list is empty again: before a step's needles are made ready. */
NDLI_API void ndli_held_forget(struct ndli_site *site);
/* After a substep: the tip enters, goes on, or back. What cannot be done holds it. */
NDLI_API void ndli_held_follow_tip(ndl_needle *needle);
/* It is outside. */
NDLI_API void ndli_held_leave(ndl_needle *needle);
/* Length (m) of the bends that a side load makes of a needle of that stiffness (N m^2) and radius (m) in tissue of such
 * a modulus (Pa): (4 EI / k)^(1/4). */
NDLI_API double ndli_held_wave(double bending, double radius, double young, double guess);

/* ---- needle_membrane ---- */

/* 0: a membrane between regions that do not meet (*bad is its number), or no memory (*bad -1). */
NDLI_API int ndli_needle_make_capsules(ndl_needle *needle, const ndl_membrane *membranes, int count, int *bad);
/* What cutting at X takes (N), where the tissue takes `tissue`. */
NDLI_API double ndli_needle_cut_membranes(const ndl_needle *needle, sb_vec3 X, double tissue);
/* Share of a substep of dt (s) at which the tip comes to where what they add changes, or a little more; 1: nowhere but
 * at its very end. Of one that is solved, with the rod moved, before the tip is followed: there the body's mesh is
 * still what it was. */
NDLI_API double ndli_needle_share_to_edge(const ndl_needle *needle, double dt);

/* ---- needle_resist ---- */

/* Force (N) to cut at X of a region, `table` its friction's. */
NDLI_API double ndli_needle_cutting_at(const ndl_needle *needle, sb_vec3 X, int region, double table);

/* Friction of the line's nodes and edges, and what the tip has to cut, where they are now. */
NDLI_API void ndli_needle_resist(ndl_needle *needle);

/* ---- needle_tip ---- */

/* Where a tip looks in space: where its path goes on, where that is known better than by the last edge. */
NDLI_API ndli_v3 ndli_needle_heading(const ndl_needle *needle);
/* After a substep: the tip enters, goes on, or back; needle->advance says how far. What could not be done holds the tip
 * and is no failure, but for SB_ERROR_UNSUPPORTED: another needle's element is in the way. */
NDLI_API sb_result ndli_needle_follow_tip(ndl_needle *needle, ndl_remesh_info *done, sb_error *error);

/* ---- needle_nodes ---- */

/* 1 when the rod's nodes are at those of its path. */
NDLI_API int ndli_needle_is_threaded(const ndl_needle *needle);

/* Once the remesher has followed the tip: the rod's nodes on those of its path, and about as many outside as should be.
 * Friction states go with them. Returns -1, the node at which the rod is folded, or the rod's capacity when that is too
 * little: then it has its old nodes. */
NDLI_API int ndli_needle_renew_nodes(ndl_needle *needle);

/* ---- needle_state ---- */

/* What the ints of a command in a recording begin with. */
typedef enum ndli_needle_command {
    NDLI_COMMAND_STEP = 1,        /* and the number of needles and their indices; dt, then each needle's ndl_command */
    NDLI_COMMAND_BASE = 2,        /* and the needle; base, direction, director */
    NDLI_COMMAND_NEEDLE_MADE = 3, /* and the needle */
    NDLI_COMMAND_NEEDLE_GONE = 4
} ndli_needle_command;
enum { NDLI_COMMAND_REALS = 8 }; /* of an ndl_command */

/* The part of the body's state that the site is, but for its replay. */
NDLI_API sbi_state_part ndli_site_part(struct ndli_site *site);
/* What the needles of a body share, by the part's name; NULL: it has none. */
NDLI_API struct ndli_site *ndli_needle_site(const sb_body *body);
NDLI_API void ndli_site_leave(const struct ndli_site *site);
/* For the recording of the body. */
NDLI_API void ndli_needle_tell_life(const ndl_needle *needle, ndli_needle_command command);
NDLI_API void ndli_needle_tell_base(const ndl_needle *needle, sb_vec3 base, sb_vec3 direction, sb_vec3 director);
NDLI_API void ndli_needle_tell_step(const struct ndli_site *site, ndl_needle *const *needles, int count, sb_real dt,
                                    const ndl_command *commands, sb_result result);

/* ---- needle_step ---- */

/* Does a recorded command again; user: the site. */
NDLI_API sb_result ndli_needle_replay(void *user, const int *ints, size_t int_count, const sb_real *reals,
                                      size_t real_count, sb_error *error);

/* ---- needle_undo ---- */

/* Memory for all that steps keep, with one more needle than there are unless NULL, while the mesh keeps to its slack;
 * 0: there is none. */
NDLI_API int ndli_needle_reserve_undo(struct ndli_site *site, const ndl_needle *more);
/* Keeps what a step changes of a body and its needles. Takes memory where the mesh has outgrown its slack; 0: there is
 * none. */
NDLI_API int ndli_needle_keep(struct ndli_site *site, ndli_keeping which);
/* Brings it back. SB_ERROR_MEMORY, where the mesh has changed since: nothing has changed, and undo_waits is set. */
NDLI_API sb_result ndli_needle_undo(struct ndli_site *site, ndli_keeping which, sb_error *error);
/* The same where it waits; else does nothing. */
NDLI_API sb_result ndli_needle_finish_undo(struct ndli_site *site, sb_error *error);
/* Where the body has got another mesh since the last step: needles are outside, whatever they were in.
 * SB_ERROR_MEMORY. */
NDLI_API sb_result ndli_needle_look(struct ndli_site *site, sb_error *error);
#endif

#endif /* NDL_NEEDLE_PRIVATE_H */

/* ==== src/needle/needle_site.c ==== */
/* needle_site: what the needles of one body share. */


#include <string.h>

/* Takes each edge once: at the tet about it whose slot is the lowest. */
NDLI_API double ndli_site_mean_edge(const ndli_topology *mesh)
{
    static const int pairs[6][2] = {{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}};
    double sum = 0;
    int count = 0;
    for (int t = 0; t < mesh->tet_end; t++)
        for (int p = 0; p < 6 && mesh->tets[4 * (size_t)t] >= 0; p++) {
            int i = mesh->tets[4 * (size_t)t + (size_t)pairs[p][0]],
                j = mesh->tets[4 * (size_t)t + (size_t)pairs[p][1]];
            if (ndli_topology_first_tet(mesh, i, j) != t)
                continue;
            sum += (double)sb_v3_norm(sb_v3_sub(mesh->X[i], mesh->X[j]));
            count++;
        }
    return count ? sum / count : 0;
}

/* What there is to be done when the mesh changes the remesher does; a bed goes along with cuts alone. */
static void ndli_site_follow(void *user, const sb_body *body, const sb_mesh_change *change)
{
    struct ndli_site *site = (struct ndli_site *)user;
    site->bed.is_lost |= change ? !change->find_cell : !sbi_body_has_finder(body); /* NULL: a state was loaded */
}

NDLI_API sb_result ndli_site_listen(struct ndli_site *site, sb_error *error)
{
    sb_body_listener listener;
    if (!sbi_body_is_live(site->body))
        return SB_OK;
    memset(&listener, 0, sizeof listener);
    listener.user = site;
    listener.follow = ndli_site_follow;
    return sb_body_listen(site->body, &listener, &site->listener, error);
}

NDLI_API void ndli_site_free(struct ndli_site *site)
{
    sb_allocator allocator = site->allocator;
    if (site->listener)
        sb_body_unlisten(site->body, site->listener);
    ndl_remesh_destroy(site->remesh);
    ndli_bed_free(&site->bed);
    ndli_bed_free(&site->next_bed);
    sbi_free(&allocator, site->node_place);
    sbi_free(&allocator, site->coupled);
    sbi_free(&allocator, site->unknown);
    for (int i = 0; i < NDLI_KEPT_COUNT; i++)
        sbi_free(&allocator, site->kept[i].bytes);
    sbi_free(&allocator, site);
}

NDLI_API int ndli_site_free_index(const struct ndli_site *site)
{
    int index = 0;
    while (site->needles[index])
        index++;
    return index;
}

NDLI_API int ndli_site_is_stale(const struct ndli_site *site)
{
    if (!site->embeds)
        return ndli_remesh_is_stale(site->remesh);
    return site->bed.version != sb_body_mesh_version(site->body) &&
           (site->bed.is_lost || !sbi_body_has_finder(site->body));
}

/* Of the mesh before any cut where that is known: it is the same whenever needles are made, and so for states. */
NDLI_API sb_result ndli_site_create_bed(const struct ndli_site *site, ndli_bed *bed, sb_error *error)
{
    return ndli_bed_create(site->body, site->body, sbi_body_has_uncut(site->body), &site->allocator, bed, error);
}

NDLI_API sb_result ndli_site_look(struct ndli_site *site, sb_error *error)
{
    ndli_bed fresh;
    sb_result result;
    if (!site->embeds)
        return ndli_remesh_look(site->remesh, error);
    if (!ndli_site_is_stale(site))
        return SB_OK;
    result = ndli_site_create_bed(site, &fresh, error);
    if (result != SB_OK)
        return result;
    ndli_bed_replace(&site->bed, &fresh);
    return SB_OK;
}

/* Nodes of the body that so many rod nodes may be at, or held by. */
static size_t ndli_site_row_nodes(const struct ndli_site *site, size_t rod_nodes)
{
    return site->embeds ? rod_nodes * (size_t)sb_mesh_element_width(&site->bed.mesh) : rod_nodes;
}

/* The numbers of the body's nodes, for all slots that there may be. */
NDLI_API int ndli_site_reserve_places(struct ndli_site *site)
{
    sbi_body_slots slots = sbi_body_node_slots(site->body);
    size_t room = (size_t)(sbi_body_is_live(site->body) ? slots.room : sb_body_node_count(site->body));
    int *grown;
    if (!site->embeds || room <= site->place_room)
        return 1;
    grown = (int *)sbi_alloc(&site->allocator, room, sizeof(int));
    if (!grown)
        return 0;
    for (size_t i = 0; i < room; i++)
        grown[i] = -1;
    ndli_held_forget(site);
    sbi_free(&site->allocator, site->node_place);
    site->node_place = grown;
    site->place_room = room;
    return 1;
}

NDLI_API int ndli_site_reserve(struct ndli_site *site, int more)
{
    size_t room = (size_t)more;
    int *coupled;
    double *unknown;
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        room += site->needles[i] ? (size_t)site->needles[i]->rod->capacity : 0;
    if (!ndli_site_reserve_places(site))
        return 0;
    if (room <= site->node_room)
        return 1;
    ndli_held_forget(site);
    coupled = (int *)sbi_alloc(&site->allocator, ndli_site_row_nodes(site, room), sizeof(int));
    unknown = (double *)sbi_alloc(&site->allocator, room, NDLI_LINE_UNKNOWNS * sizeof(double));
    if (!coupled || !unknown) {
        sbi_free(&site->allocator, coupled);
        sbi_free(&site->allocator, unknown);
        return 0;
    }
    sbi_free(&site->allocator, site->coupled); /* they hold nothing between steps */
    sbi_free(&site->allocator, site->unknown);
    site->coupled = coupled;
    site->unknown = unknown;
    site->node_room = room;
    site->coupled_room = ndli_site_row_nodes(site, room);
    return 1;
}

/* ==== src/needle/needle_bevel.c ==== */
/* needle_bevel: how the way of a tip bends. It turns by the bevel's curvature towards where the bevel looks, while that
 * turns with the needle: exactly over a step (Webster et al. 2006). How far the way may leave the shaft's direction is
 * limited; so soft tissue, in which a shaft bends over a length lam, gives that angle over lam in place of the
 * curvature. */

NDLI_API double ndli_bevel_curvature(const ndl_bevel *bevel)
{
    sb_real curvature = bevel->curvature;
    if (bevel->law == NDL_BEVEL_ANGLE)
        (void)ndl_bevel_curvature(bevel, 0, bevel->guide, &curvature);
    return (double)curvature;
}

NDLI_API double ndli_bevel_lag(const ndl_bevel *bevel)
{
    return bevel->law == NDL_BEVEL_ANGLE ? fabs((double)bevel->angle) : (double)bevel->lag;
}

static ndli_v3 ndli_bevel_side(const ndl_needle *needle)
{
    return ndli_from(ndl_rod_frame(needle->rod, needle->rod->node_count - 2).m2);
}

NDLI_API int ndli_bevel_is_coarse(const ndl_needle *needle)
{
    return !needle->site->embeds && needle->line.count > 0 &&
           fabs(ndli_bevel_curvature(&needle->bevel)) * needle->wave > ndli_bevel_lag(&needle->bevel);
}

NDLI_API void ndli_bevel_begin(ndl_needle *needle) { needle->side = ndli_bevel_side(needle); }

/* The end of a shaft has no moment: its last edge, turned on by an eighth of the curvature behind it. An edge longer
 * than the shaft's bends does not show these: there the shaft follows the way that is cut, whose turn within the edge
 * is no lag. */
NDLI_API ndli_v3 ndli_bevel_shaft(const ndl_needle *needle, ndli_v3 heading, ndli_v3 chord)
{
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 2;
    double length = rod->rest_length[last], share = length > needle->wave ? needle->wave / length : 1;
    ndli_v3 t = rod->tangent[last], shaft = ndli_madd(t, 1 - share, ndli_sub(heading, chord));
    if (last > 0)
        shaft = ndli_madd(shaft, share * length / (8 * rod->cell[last]), ndli_sub(t, rod->tangent[last - 1]));
    return ndli_scale(1 / ndli_norm(shaft), shaft);
}

/* heading, or the nearest to it that is no farther from the shaft than `lag`. */
static ndli_v3 ndli_bevel_within(ndli_v3 heading, ndli_v3 shaft, double lag)
{
    double along = ndli_dot(heading, shaft), size;
    ndli_v3 aside = ndli_madd(heading, -along, shaft);
    size = ndli_norm(aside);
    if (along > 0 && !(size > lag * along))
        return heading;
    aside = size > 0 ? ndli_madd(shaft, lag / size, aside) : shaft;
    return ndli_scale(1 / ndli_norm(aside), aside);
}

/* A helix from a pose at the origin, as the bevel turns. */
static ndli_pose ndli_bevel_helix(const ndl_needle *needle, ndli_v3 heading, double advance)
{
    ndli_pose pose;
    ndli_v3 after;
    double turn;
    pose.p = ndli_v(0, 0, 0);
    pose.t = heading;
    pose.m2 = ndli_rod_across(needle->side, pose.t);
    pose.m1 = ndli_cross(pose.m2, pose.t);
    after = ndli_rod_across(ndli_bevel_side(needle), pose.t);
    turn = sbi_dense_atan2(ndli_dot(ndli_cross(pose.m2, after), pose.t), ndli_dot(pose.m2, after));
    return ndli_pose_helix(&pose, ndli_bevel_curvature(&needle->bevel), turn / advance, advance);
}

NDLI_API ndli_v3 ndli_bevel_go(const ndl_needle *needle, double advance, ndli_v3 shaft, double lag, ndli_v3 *heading)
{
    ndli_v3 start = ndli_bevel_within(*heading, shaft, lag), way;
    ndli_pose end = ndli_bevel_helix(needle, start, advance);
    *heading = ndli_bevel_within(ndli_scale(1 / ndli_norm(end.t), end.t), shaft, lag);
    if (ndli_dot(*heading, end.t) > (1 - 1e-14) * ndli_norm(end.t))
        return end.p;
    way = ndli_add(start, *heading); /* held back by the shaft: on the way, too */
    return ndli_scale(advance / ndli_norm(way), way);
}

/* ==== src/needle/needle_read.c ==== */
/* needle_read: what a needle is at. */

#include <string.h>

NDL_API const ndl_rod *ndl_needle_rod(const ndl_needle *needle) { return needle ? needle->rod : NULL; }

NDL_API ndl_tip_pose ndl_needle_tip(const ndl_needle *needle)
{
    ndl_tip_pose pose;
    ndli_v3 t, ahead;
    memset(&pose, 0, sizeof pose);
    if (!needle)
        return pose;
    ahead = ndli_needle_heading(needle);
    ndl_rod_tip(needle->rod, &pose.position, &pose.frame);
    t = ndli_from(pose.frame.t);
    pose.frame.m1 = ndli_to(ndli_rod_transport(t, ahead, ndli_from(pose.frame.m1)));
    pose.frame.m2 = ndli_to(ndli_rod_transport(t, ahead, ndli_from(pose.frame.m2)));
    pose.frame.t = ndli_to(ahead);
    return pose;
}

NDL_API void ndl_needle_base_wrench(const ndl_needle *needle, sb_vec3 *force, sb_vec3 *torque)
{
    if (!needle)
        return;
    if (force)
        *force = ndli_to(needle->base_force);
    if (torque)
        *torque = ndli_to(needle->base_torque);
}

NDL_API int ndl_needle_entry(const ndl_needle *needle) { return needle ? needle->line.first : 0; }

static int ndli_needle_is_coupled(const ndl_needle *needle, int node)
{
    return node >= ndli_line_rearmost(&needle->line) && node < needle->line.first + needle->line.count;
}

NDL_API int ndl_needle_body_node(const ndl_needle *needle, int node)
{
    if (!needle)
        return 0;
    return ndli_needle_is_coupled(needle, node) && !needle->site->embeds ? needle->path[node - needle->line.first] : -1;
}

NDL_API const ndl_remesh *ndl_needle_remesh(const ndl_needle *needle) { return needle ? needle->site->remesh : NULL; }

NDL_API ndl_contact ndl_needle_contact(const ndl_needle *needle, int node)
{
    ndl_contact none;
    if (!needle) {
        memset(&none, 0, sizeof none);
        return none;
    }
    return ndli_needle_is_coupled(needle, node) ? (ndl_contact)needle->line.state[node] : NDL_FREE;
}

NDL_API sb_vec3 ndl_needle_contact_force(const ndl_needle *needle, int node)
{
    if (!needle)
        return sb_v3(0, 0, 0);
    return ndli_needle_is_coupled(needle, node) ? ndli_to(needle->line.contact[node]) : sb_v3(0, 0, 0);
}

NDL_API sb_real ndl_needle_depth(const ndl_needle *needle)
{
    double sum = 0;
    if (!needle)
        return 0;
    for (int i = needle->line.first; i + 1 < needle->rod->node_count; i++)
        sum += ndli_norm(ndli_sub(needle->rod->x[i + 1], needle->rod->x[i]));
    return (sb_real)(sum + needle->entering);
}

NDL_API sb_real ndl_needle_fed(const ndl_needle *needle) { return needle ? (sb_real)needle->fed : 0; }
NDL_API sb_real ndl_needle_advance(const ndl_needle *needle) { return needle ? (sb_real)needle->advance : 0; }
NDL_API sb_real ndl_needle_cutting(const ndl_needle *needle) { return needle ? (sb_real)needle->line.cutting : 0; }

NDL_API int ndl_needle_tip_material(const ndl_needle *needle, sb_vec3 *X)
{
    if (!needle)
        return 0;
    if (needle->line.count == 0)
        return 0;
    if (needle->site->embeds)
        *X = ndli_to(ndli_track_at(&needle->track, ndli_track_length(&needle->track)).X);
    else if (needle->shallow)
        ndl_remesh_material_point(needle->site->remesh, needle->index,
                                  ndli_to(needle->rod->x[needle->rod->node_count - 1]), X);
    else
        *X = needle->site->mesh->X[needle->path[needle->line.count - 1]];
    return 1;
}

NDLI_API const ndl_friction *ndli_needle_friction(const ndl_needle *needle, int region)
{
    int i = needle->friction_count == 1 ? 0 : region;
    return i >= 0 && i < needle->friction_count ? needle->frictions + i : NULL;
}

/* ==== src/needle/needle_state.c ==== */
/* needle_state: needles in the saved state of their body and in its recording. What is computed anew in each step is
 * not kept; what the remesher knows is its own part, which is checked before this one. */

#include <string.h>


/* By its name it comes behind the remesher's, which it is checked against. */
static const char ndli_needle_name[] = "needles";
enum { NDLI_NEEDLE_VERSION = 4 };

/* ---- the image ---- */

typedef struct ndli_site_head {
    double mean_edge;
    uint64_t bed; /* hash of what needles that are held have their tracks in; 0: none is in */
    int order, count;
    unsigned char used[NDL_MAX_NEEDLES]; /* 1: there is a needle of that index, and its image follows */
} ndli_site_head;

enum { NDLI_HEAD_VECTORS = 9, NDLI_HEAD_REALS = 5 };

typedef struct ndli_needle_head {
    uint64_t make; /* hash of what its def says beside the rod */
    double reals[NDLI_HEAD_REALS];
    ndli_v3 vectors[NDLI_HEAD_VECTORS];
    int node_count, first, count, shallow, base_given, hold_steps;
    int points; /* of its track */
    int lost;
} ndli_needle_head;

/* The fields that go from step to step, in the order of the head. */
static void ndli_needle_fields(ndl_needle *needle, double *reals[NDLI_HEAD_REALS], ndli_v3 *vectors[NDLI_HEAD_VECTORS])
{
    reals[0] = &needle->edge_length, reals[1] = &needle->fed, reals[2] = &needle->advance;
    reals[3] = &needle->line.cutting, reals[4] = &needle->entering;
    vectors[0] = &needle->outlet, vectors[1] = &needle->axis, vectors[2] = &needle->given_outlet;
    vectors[3] = &needle->given_axis, vectors[4] = &needle->given_director, vectors[5] = &needle->heading;
    vectors[6] = &needle->base_force, vectors[7] = &needle->base_torque, vectors[8] = &needle->aside;
}

static uint64_t ndli_state_hash_real(uint64_t hash, sb_real value)
{
    double wide = (double)value;
    return ndli_image_hash(hash, &wide, sizeof wide);
}

/* Tables, bevel and membranes; of a cutting of the user's own only that there is one. */
static uint64_t ndli_needle_make(const ndl_needle *needle)
{
    uint64_t hash = ndli_state_hash_real((uint64_t)needle->max_trials, needle->entry_slip);
    hash = sbi_hash_word(hash, (uint64_t)needle->bevel.law + (needle->cutting_at ? 256u : 0u));
    hash = ndli_state_hash_real(hash, needle->bevel.angle);
    hash = ndli_state_hash_real(hash, needle->bevel.curvature);
    hash = ndli_state_hash_real(ndli_state_hash_real(hash, needle->bevel.guide), needle->bevel.lag);
    for (int i = 0; i < needle->friction_count; i++) {
        const ndl_friction *f = needle->frictions + i;
        hash = ndli_state_hash_real(ndli_state_hash_real(hash, f->friction), f->viscous);
        hash = ndli_state_hash_real(hash, f->cutting);
        hash = ndli_state_hash_real(ndli_state_hash_real(hash, f->twist_stiffness), f->twist_friction);
    }
    for (int i = 0; i < needle->capsule_count; i++) {
        const ndl_membrane *m = &needle->capsules[i].def;
        hash = ndli_image_hash(hash, m->regions, sizeof m->regions);
        hash = ndli_state_hash_real(ndli_state_hash_real(hash, m->strength), m->thickness);
    }
    return hash;
}

/* stale: the body has got another mesh from others since: a needle is outside of it, as the next step will find. */
static void ndli_needle_fill_head(const ndl_needle *needle, int stale, ndli_needle_head *h)
{
    ndl_needle view = *needle;
    double *reals[NDLI_HEAD_REALS];
    ndli_v3 *vectors[NDLI_HEAD_VECTORS];
    memset(h, 0, sizeof *h);
    ndli_needle_fields(&view, reals, vectors);
    h->make = ndli_needle_make(needle);
    for (int i = 0; i < NDLI_HEAD_REALS; i++)
        h->reals[i] = *reals[i];
    for (int i = 0; i < NDLI_HEAD_VECTORS; i++)
        h->vectors[i] = *vectors[i];
    h->node_count = needle->rod->node_count;
    h->first = stale ? h->node_count : needle->line.first;
    h->count = stale ? 0 : needle->line.count;
    h->shallow = stale ? 0 : needle->shallow;
    h->base_given = needle->base_given;
    h->hold_steps = needle->hold_steps;
    h->points = h->count > 0 ? needle->track.count : 0;
    h->lost = stale && needle->line.count > 0 ? NDLI_LOST_MESH : needle->lost;
    h->reals[4] = h->count > 0 ? h->reals[4] : 0;
}

static void ndli_needle_take_head(ndl_needle *needle, const ndli_needle_head *h)
{
    double *reals[NDLI_HEAD_REALS];
    ndli_v3 *vectors[NDLI_HEAD_VECTORS];
    ndli_needle_fields(needle, reals, vectors);
    for (int i = 0; i < NDLI_HEAD_REALS; i++)
        *reals[i] = h->reals[i];
    for (int i = 0; i < NDLI_HEAD_VECTORS; i++)
        *vectors[i] = h->vectors[i];
    needle->line.first = h->first;
    needle->line.count = h->count;
    needle->shallow = h->shallow;
    needle->track.count = h->points;
    needle->track.spacing = needle->edge_length / (int)NDLI_TRACK_POINTS;
    needle->lost = h->lost;
    needle->base_given = h->base_given;
    needle->hold_steps = h->hold_steps;
    needle->blocked = needle->limited = 0;
}

/* Nodes that have a friction state: one more where its edge is held as it goes in. */
static size_t ndli_needle_states(const ndl_needle *needle, const ndli_needle_head *h)
{
    return (size_t)h->count + (needle->site->embeds && h->count > 0 ? 1 : 0);
}

/* What its nodes in the tissue have. */
static void ndli_needle_walk(ndl_needle *needle, const ndli_needle_head *h, ndli_image *image)
{
    size_t states = ndli_needle_states(needle, h), nodes = (size_t)h->count, points = (size_t)h->points;
    size_t rearmost = (size_t)h->first - (states - nodes);
    ndli_image_part(image, needle->line.state + rearmost, states, 1);
    ndli_image_part(image, needle->line.contact + rearmost, states, sizeof(ndli_v3));
    if (!needle->site->embeds) {
        ndli_image_part(image, needle->path, nodes, sizeof(int));
        ndli_image_part(image, needle->gap + h->first, nodes, sizeof(ndli_v3));
        return;
    }
    ndli_image_part(image, needle->arc + h->first, nodes, sizeof(double));
    ndli_image_part(image, needle->track.X, points, sizeof(ndli_v3));
    ndli_image_part(image, needle->track.arc, points, sizeof(double));
    ndli_image_part(image, needle->track.elements, points, sizeof(int));
}

static void ndli_site_fill_head(const struct ndli_site *site, int stale, ndli_site_head *h)
{
    memset(h, 0, sizeof *h);
    h->mean_edge = site->mean_edge;
    h->bed = stale ? 0 : site->bed.hash;
    h->order = NDLI_IMAGE_ORDER;
    h->count = site->count;
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        h->used[i] = site->needles[i] != NULL;
}

static void ndli_site_save(const void *user, sbi_state_out *out)
{
    const struct ndli_site *site = (const struct ndli_site *)user;
    int stale = ndli_site_is_stale(site);
    ndli_site_head head;
    ndli_image image;
    memset(&image, 0, sizeof image);
    image.state = out;
    ndli_site_fill_head(site, stale, &head);
    ndli_image_part(&image, &head, 1, sizeof head);
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (site->needles[i]) {
            ndl_needle view = *site->needles[i];
            ndli_needle_head needle;
            ndli_needle_fill_head(&view, stale, &needle);
            ndli_image_part(&image, &needle, 1, sizeof needle);
            ndli_needle_walk(&view, &needle, &image);
            ndli_rod_put(view.rod, out);
        }
    out->overflow |= image.overflow;
}

/* ---- checks ---- */

static int ndli_state_is_number(const double *values, size_t count)
{
    int good = 1;
    for (size_t i = 0; i < count; i++)
        good &= values[i] - values[i] == 0;
    return good;
}

static int ndli_state_is_unit(ndli_v3 v) { return fabs(ndli_norm(v) - 1) < 1e-6; }

static sb_result ndli_needle_check_head(const ndl_needle *needle, const ndli_needle_head *h, sb_error *error)
{
    if (h->make != ndli_needle_make(needle))
        return sbi_fail(error, SB_ERROR_STATE, "saved needle %d was made from another def", needle->index);
    if (!ndli_state_is_number(h->reals, NDLI_HEAD_REALS) ||
        !ndli_state_is_number(&h->vectors[0].x, 3 * NDLI_HEAD_VECTORS))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "saved needle %d holds a number that is not finite", needle->index);
    if (h->node_count > needle->rod->capacity)
        return sbi_fail(error, SB_ERROR_STATE, "saved needle %d has %d nodes, this one room for %d", needle->index,
                        h->node_count, needle->rod->capacity);
    if (h->node_count < 2 || h->count < 0 || h->first < 2 || h->first > h->node_count ||
        h->count > h->node_count - h->first || (h->count == 0) != (h->first == h->node_count) || h->points < 0 ||
        h->points > needle->track.capacity || h->lost < NDLI_LOST_NOT || h->lost > NDLI_LOST_TORN ||
        (h->lost == NDLI_LOST_TORN && !needle->site->embeds) || !ndli_state_is_unit(h->vectors[1]) ||
        (h->points > 0 && !ndli_state_is_unit(h->vectors[5])) ||
        (h->points > 0) != (h->count > 0 && needle->site->embeds) || (h->shallow != 0 && h->shallow != 1) ||
        (h->base_given != 0 && h->base_given != 1) || h->hold_steps < 0 || !(h->reals[0] > 0) || !(h->reals[4] >= 0) ||
        (h->reals[4] > 0 && h->points == 0))
        return sbi_fail(error, SB_ERROR_FORMAT, "saved needle %d is damaged", needle->index);
    return SB_OK;
}

static int ndli_image_is_number(const unsigned char *reals, size_t count)
{
    int good = 1;
    for (size_t i = 0; i < count; i++)
        good &= ndli_is_finite(ndli_image_real(reals, i));
    return good;
}

/* The rod is on nodes of the remesher's path, in their order, or at numbers beside them. */
static int ndli_needle_path_holds(const ndl_needle *needle, const unsigned char *path, int count)
{
    int there, at = 0;
    const int *nodes = ndli_remesh_staged_nodes(needle->site->remesh, needle->index, &there);
    for (int i = 0; i < count; i++) {
        int node = ndli_image_int(path, (size_t)i);
        while (at < there && nodes[at] != node)
            at++;
        if (at++ == there)
            return 0;
    }
    return ndli_image_is_number(path + ndli_image_room((size_t)count * sizeof(int)), 3 * (size_t)count);
}

/* Reals that rise from one to the next; *last is the last of them. */
static int ndli_image_rises(const unsigned char *reals, size_t count, double *last)
{
    for (size_t i = 0; i < count; i++) {
        double value = ndli_image_real(reals, i);
        if (!(value >= 0) || !ndli_is_finite(value) || (i > 0 && !(value > *last)))
            return 0;
        *last = value;
    }
    return 1;
}

/* The track is one in the bed, and the rod's nodes are on it in their order. */
static int ndli_needle_track_holds(const ndli_bed *bed, const unsigned char *arcs, const ndli_needle_head *h)
{
    size_t nodes = (size_t)h->count, points = (size_t)h->points;
    const unsigned char *X = arcs + ndli_image_room(nodes * sizeof(double));
    const unsigned char *at = X + ndli_image_room(points * sizeof(ndli_v3));
    const unsigned char *elements = at + ndli_image_room(points * sizeof(double));
    double tip = 0, last = 0;
    for (size_t i = 0; i < points; i++) {
        int element = ndli_image_int(elements, i);
        if (element < 0 || element >= bed->mesh.element_count)
            return 0;
    }
    if (!ndli_image_is_number(X, 3 * points) || !ndli_image_rises(at, points, &tip))
        return 0;
    return ndli_image_rises(arcs, nodes, &last) && (points == 0 || (last == tip && ndli_image_real(at, 0) == 0));
}

/* The needle at in[size], its track in this bed; used: its bytes. */
static sb_result ndli_needle_check_image(const ndl_needle *needle, const ndli_bed *bed, const unsigned char *in,
                                         size_t size, size_t *used, sb_error *error)
{
    ndl_needle none = *needle;
    ndli_needle_head h;
    ndli_image image;
    const unsigned char *states, *contacts, *rest;
    sb_result result;
    size_t rod, count;
    int good = 1, nodes;
    if (size < sizeof h)
        return sbi_fail(error, SB_ERROR_FORMAT, "saved needle %d ends in its head", needle->index);
    memcpy(&h, in, sizeof h);
    result = ndli_needle_check_head(needle, &h, error);
    if (result != SB_OK)
        return result;
    memset(&image, 0, sizeof image);
    image.used = ndli_image_room(sizeof h);
    ndli_needle_walk(&none, &h, &image);
    if (image.used > size)
        return sbi_fail(error, SB_ERROR_FORMAT, "saved needle %d ends before its nodes do", needle->index);
    count = ndli_needle_states(needle, &h);
    states = in + ndli_image_room(sizeof h);
    contacts = states + ndli_image_room(count);
    rest = contacts + ndli_image_room(count * sizeof(ndli_v3));
    for (size_t i = 0; i < count; i++)
        good &= states[i] > NDL_FREE && states[i] <= NDL_DYNAMIC_BACKWARD;
    if (!good || !ndli_image_is_number(contacts, 3 * count) ||
        !(needle->site->embeds ? ndli_needle_track_holds(bed, rest, &h)
                               : ndli_needle_path_holds(needle, rest, h.count)))
        return sbi_fail(error, SB_ERROR_FORMAT, "saved needle %d is damaged in its nodes", needle->index);
    result = ndli_rod_check(needle->rod, in + image.used, size - image.used, &rod, &nodes, error);
    if (result == SB_OK && nodes != h.node_count)
        result = sbi_fail(error, SB_ERROR_FORMAT, "saved needle %d has %d nodes, its rod %d", needle->index,
                          h.node_count, nodes);
    *used = image.used + (result == SB_OK ? rod : 0);
    return result;
}

static sb_result ndli_site_check_head(const struct ndli_site *site, const ndli_site_head *h, sb_error *error)
{
    if (h->order != NDLI_IMAGE_ORDER)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the saved needles are of a machine with another order of bytes");
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (h->used[i] != (site->needles[i] != NULL))
            return sbi_fail(error, SB_ERROR_STATE,
                            h->used[i] ? "the state has a needle %d, the body has not"
                                       : "the body has a needle %d, the state has not",
                            i);
    if (h->count != site->count || !(h->mean_edge > 0) || h->mean_edge - h->mean_edge != 0)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved needles are damaged in their head");
    return SB_OK;
}

/* The bed of a state: the one that there is, or one that is made from the mesh before any cut, which an sb_cut of the
 * body knows, or else from the state's. */
static sb_result ndli_site_check_bed(struct ndli_site *site, const sb_body *body, const ndli_site_head *h,
                                     const ndli_bed **bed, sb_error *error)
{
    *bed = &site->bed;
    ndli_bed_free(&site->next_bed);
    if (!h->bed || h->bed == site->bed.hash || !site->embeds)
        return SB_OK;
    *bed = &site->next_bed;
    for (int uncut = sbi_body_has_uncut(site->body); uncut >= 0; uncut--) {
        sb_result result = ndli_bed_create(site->body, body, uncut, &site->allocator, &site->next_bed, error);
        if (result == SB_ERROR_STATE && uncut)
            continue;
        if (result != SB_OK || h->bed == site->next_bed.hash)
            return result;
        ndli_bed_free(&site->next_bed);
    }
    return sbi_fail(error, SB_ERROR_STATE,
                    "the state's needles went into another mesh than those of the body know: load it into a body that "
                    "was made as its body was");
}

static sb_result ndli_site_check(void *user, const sb_body *body, const unsigned char *bytes, size_t size,
                                 sb_error *error)
{
    struct ndli_site *site = (struct ndli_site *)user;
    const ndli_bed *bed = NULL;
    ndli_site_head head;
    size_t at = ndli_image_room(sizeof head);
    sb_result result;
    if (size < at)
        return sbi_fail(error, SB_ERROR_FORMAT, "the saved needles end in their head");
    memcpy(&head, bytes, sizeof head);
    result = ndli_site_check_head(site, &head, error);
    if (result == SB_OK)
        result = ndli_site_check_bed(site, body, &head, &bed, error);
    for (int i = 0; i < NDL_MAX_NEEDLES && result == SB_OK; i++)
        if (site->needles[i]) {
            size_t used = 0;
            result = ndli_needle_check_image(site->needles[i], bed, bytes + at, size - at, &used, error);
            at += used;
        }
    if (result == SB_OK && at != size)
        result =
            sbi_fail(error, SB_ERROR_FORMAT, "the saved needles have %lu bytes too many", (unsigned long)(size - at));
    if (result != SB_OK)
        ndli_bed_free(&site->next_bed);
    return result;
}

static void ndli_site_give_up(void *user) { ndli_bed_free(&((struct ndli_site *)user)->next_bed); }

/* The body has the mesh that the tracks are in again, or one that was cut from it; hash 0: none is in. */
static void ndli_site_load_bed(struct ndli_site *site, uint64_t hash)
{
    int unknown;
    if (!site->embeds)
        return;
    if (site->next_bed.cells)
        ndli_bed_replace(&site->bed, &site->next_bed);
    /* pieces that nobody knows: the cut that made them was destroyed before the state was saved, in another body */
    unknown = hash && sbi_body_has_pieces(site->body) && !site->bed.was_cut && !sbi_body_has_finder(site->body);
    site->bed.is_lost = !hash || unknown;
    if (hash)
        site->bed.version = unknown ? -1 : sb_body_mesh_version(site->body);
}

static void ndli_site_load(void *user, const unsigned char *bytes, size_t size)
{
    struct ndli_site *site = (struct ndli_site *)user;
    ndli_site_head head;
    ndli_image image;
    (void)size;
    memset(&image, 0, sizeof image);
    image.in = bytes;
    ndli_image_part(&image, &head, 1, sizeof head);
    site->mean_edge = head.mean_edge;
    site->undo_waits = 0;
    ndli_site_load_bed(site, head.bed);
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (site->needles[i]) {
            ndl_needle *needle = site->needles[i];
            ndli_needle_head h;
            ndli_image_part(&image, &h, 1, sizeof h);
            ndli_needle_take_head(needle, &h);
            memset(needle->line.state, NDL_FREE, (size_t)h.node_count);
            ndli_needle_walk(needle, &h, &image);
            ndli_rod_rewind(needle->rod, bytes + image.used);
            image.used += ndli_rod_snapshot_size(needle->rod, h.node_count);
        }
}

NDLI_API sbi_state_part ndli_site_part(struct ndli_site *site)
{
    sbi_state_part part;
    memset(&part, 0, sizeof part);
    memcpy(part.name, ndli_needle_name, sizeof ndli_needle_name);
    part.version = NDLI_NEEDLE_VERSION;
    part.user = site;
    part.save = ndli_site_save;
    part.check = ndli_site_check;
    part.load = ndli_site_load;
    part.give_up = ndli_site_give_up;
    return part;
}

NDLI_API struct ndli_site *ndli_needle_site(const sb_body *body)
{
    return (struct ndli_site *)sbi_body_find_part(body, ndli_needle_name);
}

NDLI_API void ndli_site_leave(const struct ndli_site *site) { sbi_body_leave(site->body, ndli_needle_name); }

/* ---- recording ---- */

NDLI_API void ndli_needle_tell_life(const ndl_needle *needle, ndli_needle_command command)
{
    int ints[2];
    ints[0] = (int)command, ints[1] = needle->index;
    sbi_body_tell_part(needle->site->body, ndli_needle_name, ints, 2, NULL, 0);
}

NDLI_API void ndli_needle_tell_base(const ndl_needle *needle, sb_vec3 base, sb_vec3 direction, sb_vec3 director)
{
    const sb_vec3 places[3] = {base, direction, director};
    sb_real reals[9];
    int ints[2];
    ints[0] = NDLI_COMMAND_BASE, ints[1] = needle->index;
    for (int k = 0; k < 3; k++)
        reals[3 * k] = places[k].x, reals[3 * k + 1] = places[k].y, reals[3 * k + 2] = places[k].z;
    sbi_body_tell_part(needle->site->body, ndli_needle_name, ints, 2, reals, 9);
}

NDLI_API void ndli_needle_tell_step(const struct ndli_site *site, ndl_needle *const *needles, int count, sb_real dt,
                                    const ndl_command *commands, sb_result result)
{
    int ints[2 + NDL_MAX_NEEDLES];
    sb_real reals[1 + (int)NDLI_COMMAND_REALS * (int)NDL_MAX_NEEDLES];
    ints[0] = NDLI_COMMAND_STEP, ints[1] = count;
    reals[0] = dt;
    for (int k = 0; k < count; k++) {
        sb_real *to = reals + 1 + NDLI_COMMAND_REALS * k;
        ndl_command c;
        memset(&c, 0, sizeof c);
        if (commands)
            c = commands[k];
        ints[2 + k] = needles[k]->index;
        to[0] = c.insertion, to[1] = c.twist;
        to[2] = c.velocity.x, to[3] = c.velocity.y, to[4] = c.velocity.z;
        to[5] = c.angular_velocity.x, to[6] = c.angular_velocity.y, to[7] = c.angular_velocity.z;
    }
    sbi_body_tell_part_step(site->body, ndli_needle_name, result, ints, 2 + (size_t)count, reals,
                            1 + NDLI_COMMAND_REALS * (size_t)count);
}

/* ==== src/needle/needle_sleeve.c ==== */
/* needle_sleeve: where a needle's sleeve is after a step, and what it feeds and turns. */

NDL_API sb_result ndl_needle_move_base(ndl_needle *needle, sb_vec3 base, sb_vec3 direction, sb_vec3 director)
{
    ndli_v3 axis = ndli_from(direction), side = ndli_from(director);
    double length = ndli_norm(axis), width;
    if (!needle)
        return SB_ERROR_ARGUMENT;
    if (!sb_v3_is_finite(base) || !sb_v3_is_finite(direction) || !sb_v3_is_finite(director))
        return SB_ERROR_NOT_FINITE;
    if (!(length > 0))
        return SB_ERROR_ARGUMENT;
    axis = ndli_scale(1 / length, axis);
    width = ndli_norm(side);
    side = ndli_madd(side, -ndli_dot(side, axis), axis);
    if (width > 0 && !(ndli_norm(side) > 1e-6 * width))
        return SB_ERROR_ARGUMENT;
    if (!(1 + ndli_dot(axis, needle->axis) > 0.01))
        return SB_ERROR_ARGUMENT;
    needle->given_outlet = ndli_from(base);
    needle->given_axis = axis;
    needle->given_director = width > 0 ? ndli_scale(1 / ndli_norm(side), side) : side;
    needle->base_given = 1;
    ndli_needle_tell_base(needle, base, direction, director);
    return SB_OK;
}

/* v turned by the angle |w| about w. */
static ndli_v3 ndli_sleeve_turned(ndli_v3 v, ndli_v3 w)
{
    double angle = ndli_norm(w), s, c;
    ndli_v3 n, out;
    if (!(angle > 0))
        return v;
    sbi_dense_sin_cos(angle, &s, &c);
    n = ndli_scale(1 / angle, w);
    out = ndli_madd(ndli_scale(c, v), s, ndli_cross(n, v));
    return ndli_madd(out, (1 - c) * ndli_dot(n, v), n);
}

NDLI_API double ndli_needle_given_turn(const ndl_needle *needle, ndli_v3 axis)
{
    const ndl_rod *rod = needle->rod;
    ndli_v3 d = ndli_rod_transport(rod->tangent[0], axis, rod->director[0]), m1;
    double s, c;
    if (!(ndli_norm(needle->given_director) > 0))
        return 0;
    sbi_dense_sin_cos(rod->theta[0], &s, &c);
    m1 = ndli_madd(ndli_scale(c, d), s, ndli_cross(axis, d));
    return sbi_dense_atan2(ndli_dot(ndli_cross(m1, needle->given_director), axis),
                           ndli_dot(m1, needle->given_director));
}

/* Where the sleeve is after a substep, and how far it turns the needle. */
typedef struct ndli_sleeve {
    ndli_v3 outlet, axis;
    double turn;
} ndli_sleeve;

static ndli_sleeve ndli_sleeve_after(const ndl_needle *needle, const ndl_command *command, double dt, double share)
{
    ndli_v3 spin = ndli_from(command->angular_velocity), swing;
    ndli_sleeve sleeve;
    double along = ndli_dot(spin, needle->axis);
    swing = ndli_madd(spin, -along, needle->axis);
    sleeve.outlet = ndli_madd(needle->outlet, dt, ndli_from(command->velocity));
    sleeve.axis = ndli_sleeve_turned(needle->axis, ndli_scale(dt, swing));
    sleeve.turn = dt * ((double)command->twist + along);
    if (needle->base_given) {
        ndli_v3 axis = ndli_add(sleeve.axis, ndli_scale(share, ndli_sub(needle->given_axis, sleeve.axis)));
        sleeve.outlet = ndli_madd(sleeve.outlet, share, ndli_sub(needle->given_outlet, sleeve.outlet));
        sleeve.axis = axis;
        sleeve.turn += share * ndli_needle_given_turn(needle, ndli_scale(1 / ndli_norm(axis), axis));
    }
    sleeve.axis = ndli_scale(1 / ndli_norm(sleeve.axis), sleeve.axis);
    return sleeve;
}

/* Feeds what is there to be fed: a needle drawn in to its last two edges is held, and so is one without free nodes. */
static void ndli_sleeve_feed(ndl_needle *needle, double length)
{
    ndl_rod *rod = needle->rod;
    double left = rod->rest_length[1] + length;
    if (length == 0)
        return;
    if ((length < 0 && left < 0.2 * needle->edge_length) || (length > 0 && rod->node_count + 4 > rod->capacity) ||
        ndl_rod_feed(rod, (sb_real)length) != SB_OK) {
        needle->limited = 1;
        return;
    }
    needle->fed += length;
}

NDLI_API void ndli_needle_aim(ndl_needle *needle, const ndl_command *command, double dt, double share)
{
    ndl_rod *rod = needle->rod;
    ndli_sleeve sleeve = ndli_sleeve_after(needle, command, dt, share);
    double length = dt * (double)command->insertion;
    needle->pushed = length + ndli_dot(ndli_sub(sleeve.outlet, needle->outlet), sleeve.axis) > 0;
    ndli_sleeve_feed(needle, length);
    rod->target[1] = sleeve.outlet;
    rod->target[0] = ndli_madd(sleeve.outlet, -rod->rest_length[0], sleeve.axis);
    ndli_rod_turn_base(rod, sleeve.turn);
    needle->outlet = sleeve.outlet;
    needle->axis = sleeve.axis;
}

/* ==== src/needle/needle_membrane.c ==== */
/* needle_membrane: faces between regions that take more force to puncture: where they are, what they add to what the
 * tip has to cut, and where on its way that changes. A step ends a substep there: a tip that runs through a membrane
 * within one step would never feel it. One that ends soon after needs none: what the tip feels of the membrane begins
 * or ends less than a step later, and is as much. */

#include <string.h>

/* ---- the faces ---- */

/* The undeformed mesh that membranes lie in. */
typedef struct ndli_membrane_mesh {
    const struct ndli_site *site;
    sb_element_type type;
    int count, node_count;
    const int *elements, *neighbours;
    sb_vec3 *X; /* read only */
} ndli_membrane_mesh;

static ndli_membrane_mesh ndli_membrane_get_mesh(const struct ndli_site *site)
{
    const ndli_topology *topology = site->mesh;
    const sb_mesh *rest = &site->bed.mesh;
    ndli_membrane_mesh mesh;
    mesh.site = site;
    mesh.type = topology ? SB_TET4 : rest->element_type;
    mesh.count = topology ? topology->original_tets : rest->element_count;
    mesh.node_count = topology ? topology->original_nodes : rest->node_count;
    mesh.elements = topology ? topology->tets : rest->elements;
    mesh.neighbours = topology ? topology->neighbours : site->bed.volume.neighbours.items;
    mesh.X = topology ? topology->X0 : rest->nodes;
    return mesh;
}

static int ndli_membrane_region(const ndli_membrane_mesh *mesh, int element)
{
    const struct ndli_site *site = mesh->site;
    if (element < 0)
        return -1;
    return site->mesh ? site->mesh->regions[element] : sbi_body_cell_region(site->body, site->bed.cells[element]);
}

/* 1 when the membrane lies on a face; each inner face is looked at from its lower element. */
static int ndli_membrane_holds(const ndli_membrane_mesh *mesh, const ndl_membrane *membrane, int element, int face)
{
    int faces = sb_element_face_count(mesh->type);
    int other = mesh->neighbours[(size_t)faces * (size_t)element + (size_t)face];
    int a = ndli_membrane_region(mesh, element), b = ndli_membrane_region(mesh, other);
    if (other > element)
        return 0;
    return (a == membrane->regions[0] && b == membrane->regions[1]) ||
           (b == membrane->regions[0] && a == membrane->regions[1]);
}

/* Corners of a face, as who numbered the neighbours has them; returns how many. */
static int ndli_membrane_face(const ndli_membrane_mesh *mesh, int face, int local[SB_MAX_FACE_NODES])
{
    static const int opposite[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}}; /* of the topology */
    sb_element_type type;
    if (mesh->site->mesh) {
        memcpy(local, opposite[face], sizeof opposite[face]);
        return 3;
    }
    sb_element_face(mesh->type, face, local, &type);
    return sb_element_corner_count(type);
}

/* Faces of the membrane, as triangles between their corners: written to `triangles` when that is not NULL. */
static int ndli_membrane_gather(const ndli_membrane_mesh *mesh, const ndl_membrane *membrane, int *triangles)
{
    size_t width = (size_t)sb_element_node_count(mesh->type);
    int count = 0;
    for (int e = 0; e < mesh->count; e++)
        for (int face = 0; face < sb_element_face_count(mesh->type); face++) {
            int local[SB_MAX_FACE_NODES], parts;
            if (!ndli_membrane_holds(mesh, membrane, e, face))
                continue;
            parts = ndli_membrane_face(mesh, face, local) - 2;
            for (int part = 0; part < parts; part++, count++)
                for (int c = 0; c < 3 && triangles; c++)
                    triangles[3 * (size_t)count + (size_t)c] =
                        mesh->elements[width * (size_t)e + (size_t)local[c == 0 ? 0 : part + c]];
        }
    return count;
}

static sb_result ndli_membrane_make_surface(const ndl_needle *needle, const ndl_membrane *membrane,
                                            sb_surface **surface)
{
    ndli_membrane_mesh mesh = ndli_membrane_get_mesh(needle->site);
    sb_mesh faces;
    sb_result result;
    int count = ndli_membrane_gather(&mesh, membrane, NULL);
    if (count == 0)
        return SB_ERROR_ARGUMENT;
    memset(&faces, 0, sizeof faces);
    faces.element_type = SB_TRI3;
    faces.nodes = mesh.X;
    faces.node_count = mesh.node_count;
    faces.elements = (int *)sbi_alloc(&needle->allocator, (size_t)count, 3 * sizeof(int));
    if (!faces.elements)
        return SB_ERROR_MEMORY;
    faces.element_count = ndli_membrane_gather(&mesh, membrane, faces.elements);
    result = sb_surface_create(&faces, &needle->allocator, surface, NULL);
    sbi_free(&needle->allocator, faces.elements);
    return result;
}

NDLI_API int ndli_needle_make_capsules(ndl_needle *needle, const ndl_membrane *membranes, int count, int *bad)
{
    *bad = -1;
    for (int i = 0; i < count; i++) {
        sb_result result = ndli_membrane_make_surface(needle, membranes + i, &needle->capsules[i].surface);
        if (result != SB_OK) {
            *bad = result == SB_ERROR_MEMORY ? -1 : i;
            return 0;
        }
        needle->capsules[i].def = membranes[i];
        needle->capsule_count = i + 1;
    }
    return 1;
}

/* ---- what they ask for ---- */

/* How far X is outside of where the membrane is felt (m), negative within; `reach` where it is farther than that. */
static double ndli_membrane_clearance(const ndli_capsule *capsule, ndli_v3 X, double reach)
{
    double half = 0.5 * (double)capsule->def.thickness;
    sb_surface_hit hit;
    if (!sb_surface_closest(capsule->surface, ndli_to(X), (sb_real)(half + reach), &hit))
        return reach;
    return (double)hit.distance - half;
}

/* What cutting the harder of a membrane's tissues takes (N). */
static double ndli_membrane_harder(const ndl_needle *needle, const ndl_membrane *membrane)
{
    double most = 0;
    for (int side = 0; side < 2; side++) {
        const ndl_friction *friction = ndli_needle_friction(needle, membrane->regions[side]);
        most = fmax(most, friction ? (double)friction->cutting : 0);
    }
    return most;
}

NDLI_API double ndli_needle_cut_membranes(const ndl_needle *needle, sb_vec3 X, double tissue)
{
    double sum = 0;
    for (int i = 0; i < needle->capsule_count; i++) {
        const ndl_membrane *membrane = &needle->capsules[i].def;
        if (!sb_surface_closest(needle->capsules[i].surface, X, membrane->thickness / 2, NULL))
            continue;
        sum += (double)membrane->strength;
        tissue = fmax(tissue, ndli_membrane_harder(needle, membrane));
    }
    return sum + tissue;
}

/* Of a membrane's thickness, or of the way where that is much longer: how far past the edge of one a tip may be found.
 */
static const double ndli_membrane_slack = 0.02, ndli_membrane_least_stride = 1.0 / 64;

/* Of a membrane's thickness: how far past an edge of one a step may take a tip. Of a skin, which is felt over half of
 * its thickness, that leaves half. */
static const double ndli_membrane_most_past = 0.25;

/* The way at which the tip comes into, or out of, where this one is felt (m, a little past it); `length`: nowhere. The
 * distance to a surface changes by no more than one goes: by so much one may go on. */
static double ndli_membrane_edge(const ndli_capsule *capsule, ndli_v3 X, ndli_v3 way, double length)
{
    double thickness = (double)capsule->def.thickness, stride = ndli_membrane_least_stride * length;
    double slack = fmax(ndli_membrane_slack * thickness, stride),
           most = fmax(ndli_membrane_most_past * thickness, stride);
    double clear = ndli_membrane_clearance(capsule, X, length), gone = 0;
    int within = clear <= 0;
    while (gone < length && (clear <= 0) == within) {
        gone += fmax(fabs(clear), slack);
        clear = ndli_membrane_clearance(capsule, ndli_madd(X, gone / length, way), length);
    }
    return gone + most < length ? gone : length;
}

/* Share of the way between two points of the material at which what membranes ask for changes, or a little more; 1:
 * nowhere but at its very end. */
static double ndli_membrane_share(const ndl_needle *needle, ndli_v3 X, ndli_v3 way)
{
    double length = ndli_norm(way), least = length;
    for (int i = 0; i < needle->capsule_count && length > 0; i++)
        least = fmin(least, ndli_membrane_edge(needle->capsules + i, X, way, length));
    return least < length ? least / length : 1;
}

/* The way of a tip in the tissue (m in the material), which the mesh and the track do not follow yet; from *X. */
static ndli_v3 ndli_membrane_way(const ndl_needle *needle, ndli_v3 *X)
{
    const ndl_rod *rod = needle->rod;
    ndl_remesh *remesh = needle->site->remesh;
    int last = rod->node_count - 1, foremost = ndli_line_foremost(&needle->line);
    double slip = needle->line.slip[foremost];
    ndli_v3 before = ndli_madd(rod->x[last], -slip, rod->tangent[last - 1]);
    sb_vec3 from, to;
    ndl_needle_tip_material(needle, &from);
    *X = ndli_from(from);
    if (needle->site->embeds)
        return ndli_scale(slip / needle->stretch[foremost], needle->heading);
    ndl_remesh_material_point(remesh, needle->index, ndli_to(rod->x[last]), &to);
    if (needle->shallow) { /* where it was is where it is now, less its slip */
        ndl_remesh_material_point(remesh, needle->index, ndli_to(before), &from);
        *X = ndli_from(from);
    }
    return ndli_sub(ndli_from(to), *X);
}

/* Thickness of the skin, where that is a membrane (m); -1: it is none. */
static double ndli_membrane_skin(const ndl_needle *needle)
{
    double thickness = -1;
    for (int i = 0; i < needle->capsule_count; i++) {
        const ndl_membrane *membrane = &needle->capsules[i].def;
        if (membrane->regions[0] < 0 || membrane->regions[1] < 0)
            thickness = (double)membrane->thickness;
    }
    return thickness;
}

/* How far a tip has come through the skin that was outside (m). */
static double ndli_membrane_past_skin(const ndl_needle *needle)
{
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1;
    sb_vec3 from = ndli_to(rod->x[last - 1]), to = ndli_to(rod->x[last]), at = to;
    ndl_surface_hit hit;
    ndli_place place;
    if (needle->site->embeds)
        return ndli_bed_hit(&needle->site->bed, from, to, &place, &at) ? (double)sb_v3_norm(sb_v3_sub(to, at)) : 0;
    if (!ndli_topology_hit(needle->site->mesh, from, to, &hit))
        return 0;
    return (1 - (double)hit.along) * (double)sb_v3_norm(sb_v3_sub(to, from));
}

/* The same of a tip that was outside, and went `way` (m). */
static double ndli_membrane_share_to_skin(const ndl_needle *needle, double way)
{
    double thickness = ndli_membrane_skin(needle), past;
    if (thickness < 0)
        return 1;
    past = ndli_membrane_past_skin(needle);
    return past > ndli_membrane_most_past * thickness && past < way ? 1 - (past - ndli_membrane_slack * thickness) / way
                                                                    : 1;
}

NDLI_API double ndli_needle_share_to_edge(const ndl_needle *needle, double dt)
{
    const ndl_rod *rod = needle->rod;
    ndli_v3 X, way;
    if (needle->capsule_count == 0 || needle->lost)
        return 1;
    if (needle->line.count == 0)
        return ndli_membrane_share_to_skin(needle, dt * ndli_norm(rod->v[rod->node_count - 1]));
    if (!(needle->line.slip[ndli_line_foremost(&needle->line)] > 0))
        return 1;
    way = ndli_membrane_way(needle, &X);
    return ndli_membrane_share(needle, X, way);
}

/* ==== src/needle/needle_resist.c ==== */
/* needle_resist: what the tissue does to a needle: friction along it, forces that its tip must cut with. */

#include <string.h>

/* ---- friction ---- */

/* Mean over the tets of a tissue node, by volume. */
static void ndli_resist_at(const ndl_needle *needle, int node, double mean[5])
{
    const ndli_topology *mesh = needle->site->mesh;
    double total = 0;
    memset(mean, 0, 5 * sizeof *mean);
    for (int k = mesh->node_star[node]; k >= 0; k = mesh->corner_next[k]) {
        const ndl_friction *f = ndli_needle_friction(needle, mesh->regions[k / 4]);
        double volume = (double)mesh->volumes[k / 4];
        total += volume;
        if (!f)
            continue;
        mean[0] += volume * (double)f->friction;
        mean[1] += volume * (double)f->viscous;
        mean[2] += volume * (double)f->cutting;
        mean[3] += volume * (double)f->twist_stiffness;
        mean[4] += volume * (double)f->twist_friction;
    }
    for (int i = 0; i < 5 && total > 0; i++)
        mean[i] /= total;
}

/* ---- cutting ---- */

/* The region that the tip looks into. */
static int ndli_resist_region_ahead(const ndl_needle *needle, int tip)
{
    const ndli_topology *mesh = needle->site->mesh;
    sb_vec3 t = ndli_to(needle->rod->tangent[needle->rod->node_count - 2]);
    sb_real best = -SB_REAL_MAX;
    int region = -1;
    for (int k = mesh->node_star[tip]; k >= 0; k = mesh->corner_next[k]) {
        const int *n = mesh->tets + 4 * (size_t)(k / 4);
        sb_vec3 sum = sb_v3_add(sb_v3_add(mesh->x[n[0]], mesh->x[n[1]]), sb_v3_add(mesh->x[n[2]], mesh->x[n[3]]));
        sb_vec3 way = sb_v3_sub(sb_v3_scale((sb_real)0.25, sum), mesh->x[tip]);
        sb_real ahead = sb_v3_dot(way, t) / sb_v3_norm(way);
        if (ahead > best) {
            best = ahead;
            region = mesh->regions[k / 4];
        }
    }
    return region;
}

NDLI_API double ndli_needle_cutting_at(const ndl_needle *needle, sb_vec3 X, int region, double table)
{
    if (needle->cutting_at) {
        sb_real force = needle->cutting_at(needle->cutting_user, X, region);
        return force > 0 && sb_is_finite(force) ? (double)force : 0;
    }
    return ndli_needle_cut_membranes(needle, X, table);
}

static double ndli_resist_cutting(const ndl_needle *needle, int tip, double table)
{
    sb_vec3 X;
    ndl_needle_tip_material(needle, &X);
    return ndli_needle_cutting_at(needle, X, needle->cutting_at ? ndli_resist_region_ahead(needle, tip) : 0, table);
}

/* A tip that comes near the skin from inside is stopped: nothing can follow it out, and tets ahead of it get flat. */
static int ndli_resist_is_at_skin(const ndl_needle *needle)
{
    const ndli_topology *mesh = needle->site->mesh;
    int tip;
    sb_real ahead = (sb_real)(0.2 * needle->site->mean_edge);
    sb_vec3 way;
    if (needle->shallow || needle->line.count < 2)
        return 0;
    tip = needle->path[needle->line.count - 1];
    way = sb_v3_sub(mesh->X[tip], mesh->X[needle->path[needle->line.count - 2]]);
    return ndli_topology_find(mesh, mesh->X, sb_v3_madd(mesh->X[tip], ahead / sb_v3_norm(way), way),
                              mesh->node_star[tip] / 4, NULL) < 0;
}

/* What the tip has to cut, or what nothing can overcome. */
static void ndli_resist_tip(ndl_needle *needle, int tip, double table)
{
    ndli_line *line = &needle->line;
    int last = ndli_line_foremost(line);
    line->cutting = ndli_resist_cutting(needle, tip, table);
    if (needle->hold_steps == 0 && !ndli_resist_is_at_skin(needle))
        return;
    needle->blocked = 1;
    line->cutting = (double)SB_REAL_MAX;
    if (line->state[last] == NDL_DYNAMIC_FORWARD)
        line->state[last] = NDL_STATIC;
}

/* ---- all of it ---- */

NDLI_API void ndli_needle_resist(ndl_needle *needle)
{
    ndl_rod *rod = needle->rod;
    ndli_line *line = &needle->line;
    int last = ndli_line_foremost(line), ends = rod->node_count - 1;
    double before[5] = {0, 0, 0, 0, 0}, here[5];
    line->cutting = 0;
    for (int i = line->first; i <= last; i++) {
        int tip = needle->path[i - line->first];
        double behind = i > line->first ? ndli_norm(ndli_sub(rod->x[i], rod->x[i - 1])) : 0;
        double ahead = i < ends ? ndli_norm(ndli_sub(rod->x[i + 1], rod->x[i])) : 0;
        double length = 0.5 * (behind + ahead) + (i == last ? 0.5 * ahead : 0); /* a shallow tip has no node */
        ndli_resist_at(needle, tip, here);
        line->friction[i] = length * here[0];
        line->viscous[i] = length * here[1];
        if (i == last && i < ends)
            ndl_rod_set_grip(rod, i, (sb_real)(ahead * here[3]), (sb_real)(ahead * here[4]));
        if (i == last)
            ndli_resist_tip(needle, tip, here[2]);
        if (i > line->first)
            ndl_rod_set_grip(rod, i - 1, (sb_real)(0.5 * behind * (before[3] + here[3])),
                             (sb_real)(0.5 * behind * (before[4] + here[4])));
        memcpy(before, here, sizeof before);
    }
    for (int j = 0; j < sbi_min_int(line->first, ends); j++)
        ndl_rod_set_grip(rod, j, 0, 0);
}

/* ==== src/needle/needle_held.c ==== */
/* needle_held: needles that the body holds by rows of weights, its mesh left as it is (NDL_EMBED): where each rod node
 * is on the way that the tip has cut, what the tissue does to it there, and how the tip goes on.
 *
 * A rod node in the tissue is at an arc of the track, which grows by what the node slips; that is all there is to
 * remember: how far the rod is past the tissue follows from where both are. The node before the first in the tissue has
 * a hold on its edge, where that goes in, so that forces do not jump when it follows. */

#include <string.h>

/* ---- what a mesh does not show of the tissue about a needle ---- */

/* Of an element's edge: radius over which a mesh spreads a line of point loads. Measured in tet4 (0.56 to 0.70), in
 * others by what makes a needle in them as stiff as in fine tet4; quadratic ones have nodes at half of their edges. */
static double ndli_held_spread(sb_element_type type)
{
    switch (type) {
    case SB_TET4: return 0.58;
    case SB_HEX8: return 0.42;
    default: return 0.2;
    }
}

/* Least ratio of that radius to the needle's: with finer meshes the needle is held as if it were thinner. */
static const double ndli_held_least_ratio = 1.5;
static const double ndli_held_pi = 3.14159265358979323846;

typedef struct ndli_held_tissue {
    double shear, poisson; /* Pa */
    double ratio;          /* logarithm of the mesh's radius over the needle's */
} ndli_held_tissue;

static ndli_held_tissue ndli_held_get_tissue(const ndl_needle *needle, int element, const ndli_bed_row *row)
{
    const ndli_bed *bed = &needle->site->bed;
    sbi_body_modulus modulus = sbi_body_cell_modulus(bed->body, row->cell);
    double radius = ndli_held_spread(bed->mesh.element_type) * ndli_bed_edge(bed, element);
    ndli_held_tissue tissue;
    tissue.poisson = modulus.poisson;
    tissue.shear = modulus.young / (2 * (1 + tissue.poisson));
    tissue.ratio = log(fmax(radius / needle->radius, ndli_held_least_ratio));
    return tissue;
}

/* N/m per m of shaft: Kelvin's line load across and along, between the two radii. */
static double ndli_held_across(const ndli_held_tissue *t)
{
    return 8 * ndli_held_pi * t->shear * (1 - t->poisson) / ((3 - 4 * t->poisson) * t->ratio);
}
static double ndli_held_along(const ndli_held_tissue *t) { return 2 * ndli_held_pi * t->shear / t->ratio; }

/* N/m of the tip: a rigid disc that moves along its axis (Selvadurai 1976). */
static double ndli_held_tip(const ndl_needle *needle, const ndli_held_tissue *t)
{
    return 32 * (1 - t->poisson) / (3 - 4 * t->poisson) * t->shear * needle->radius;
}

NDLI_API double ndli_held_wave(double bending, double radius, double young, double guess)
{
    double wave = guess;
    for (int round = 0; round < 4; round++) {
        ndli_held_tissue t;
        t.poisson = 0.45; /* of soft tissue; it matters little */
        t.shear = young / (2 * (1 + t.poisson));
        t.ratio = log(fmax(wave / radius, ndli_held_least_ratio));
        wave = sqrt(sqrt(4 * bending / ndli_held_across(&t)));
    }
    return wave;
}

/* ---- holds ---- */

/* Where hold i is on the track (m at rest). */
static double ndli_held_arc(const ndl_needle *needle, int i) { return i < needle->line.first ? 0 : needle->arc[i]; }

static double ndli_held_edge(const ndl_rod *rod, int j) { return ndli_norm(ndli_sub(rod->x[j + 1], rod->x[j])); }

/* The material at an arc of the track, and how long the tissue is there along it, per length at rest. 0: there is none:
 * it has been taken away, or the tip had come out through a hole in the far side. */
typedef struct ndli_held_spot {
    ndli_place place;
    ndli_bed_row row;
    double stretch;
} ndli_held_spot;

static double ndli_held_stretch(const ndli_bed *bed, const ndli_held_spot *spot, ndli_v3 tangent)
{
    sb_mat3 f = ndli_bed_gradient(bed, &spot->place, &spot->row);
    double stretch = ndli_norm(ndli_from(sb_m3_apply(f, ndli_to(tangent))));
    return stretch > 0 && sb_m3_det(f) > 0 ? stretch : 1;
}

static int ndli_held_find(const ndl_needle *needle, double arc, ndli_held_spot *spot)
{
    const ndli_bed *bed = &needle->site->bed;
    ndli_track_point point = ndli_track_at(&needle->track, arc);
    spot->stretch = 1;
    if (!ndli_bed_find(bed, ndli_to(point.X), point.element, &spot->place, &spot->row))
        return 0;
    if (ndli_norm(point.tangent) > 0)
        spot->stretch = ndli_held_stretch(bed, spot, point.tangent);
    return 1;
}

static ndli_v3 ndli_held_tangent(const ndl_rod *rod, int i)
{
    ndli_v3 sum = ndli_add(rod->tangent[sbi_min_int(i, rod->node_count - 2)], rod->tangent[sbi_max_int(i - 1, 0)]);
    return ndli_scale(1 / ndli_norm(sum), sum);
}

static void ndli_held_add_friction(const ndl_friction *friction, double share, ndl_friction *sum)
{
    sum->friction += (sb_real)(share * (double)friction->friction);
    sum->viscous += (sb_real)(share * (double)friction->viscous);
    sum->cutting += (sb_real)(share * (double)friction->cutting);
    sum->twist_stiffness += (sb_real)(share * (double)friction->twist_stiffness);
    sum->twist_friction += (sb_real)(share * (double)friction->twist_friction);
}

/* What the tissue at a row has, of an element in several regions by their shares of its volume; zeros where it has
 * none. */
static ndl_friction ndli_held_friction(const ndl_needle *needle, const ndli_bed_row *row)
{
    const sb_body *body = needle->site->body;
    int parts = row->count ? sbi_body_part_count(body, row->cell) : 0;
    ndl_friction sum;
    memset(&sum, 0, sizeof sum);
    for (int k = 0; k < parts; k++) {
        const ndl_friction *friction = ndli_needle_friction(needle, sbi_body_cell_region(body, row->cell + k));
        if (friction)
            ndli_held_add_friction(friction, sbi_body_part_share(body, row->cell, k), &sum);
    }
    return sum;
}

/* How far the shaft may be ahead of the tissue before it slips (m). */
static double ndli_held_slack(const ndl_needle *needle, const ndli_held_spot *spot)
{
    ndl_friction friction = ndli_held_friction(needle, &spot->row);
    ndli_held_tissue tissue = ndli_held_get_tissue(needle, spot->place.element, &spot->row);
    return (double)friction.friction / ndli_held_along(&tissue);
}

/* How far before the first node the rod goes in (m): as far as that is on the track, and by what a tip is ahead of the
 * tissue that the shaft is not. */
static double ndli_held_reach(const ndl_needle *needle, double *stretch)
{
    const ndl_rod *rod = needle->rod;
    int first = needle->line.first;
    ndli_held_spot spot;
    ndli_v3 ahead;
    double wound, slack;
    *stretch = 1;
    if (!ndli_held_find(needle, needle->arc[first], &spot))
        return needle->arc[first];
    ahead = ndli_sub(rod->x[first], ndli_bed_at(&needle->site->bed, &spot.row));
    wound = ndli_dot(ndli_held_tangent(rod, first), ahead);
    slack = ndli_held_slack(needle, &spot);
    *stretch = spot.stretch;
    return spot.stretch * needle->arc[first] + wound - fmin(fmax(wound, -slack), slack);
}

static void ndli_held_measure_entering(ndl_needle *needle)
{
    double stretch, reach = needle->line.count > 0 ? ndli_held_reach(needle, &stretch) : 0;
    needle->entering =
        needle->line.count > 0 ? fmin(fmax(reach, 0), ndli_held_edge(needle->rod, needle->line.first - 1)) : 0;
}

/* How far on the track a node may be that the next one is not to be passed by (m). */
static double ndli_held_most_arc(const ndl_needle *needle, int i)
{
    return needle->arc[i + 1] - 0.05 * needle->rod->rest_length[i];
}

/* Length of shaft in the tissue that counts with hold i: half of what is to either side. */
static double ndli_held_length(const ndl_needle *needle, int i)
{
    const ndl_rod *rod = needle->rod;
    int first = needle->line.first;
    double sum = 0;
    if (i < first)
        return 0.5 * needle->entering;
    sum += i == first ? needle->entering : ndli_held_edge(rod, i - 1);
    sum += i + 1 < rod->node_count ? ndli_held_edge(rod, i) : 0;
    return 0.5 * sum;
}

static ndli_v3 ndli_held_place(const ndl_needle *needle, int i)
{
    const ndl_rod *rod = needle->rod;
    double share = needle->line.holds[i].share;
    return share > 0 ? ndli_madd(rod->x[i], share, ndli_sub(rod->x[i + 1], rod->x[i])) : rod->x[i];
}

/* Number of a body's node in the guest's list. */
static int ndli_held_number(struct ndli_site *site, int node)
{
    if (site->node_place[node] < 0) {
        site->node_place[node] = site->coupled_count;
        site->coupled[site->coupled_count++] = node;
    }
    return site->node_place[node];
}

static void ndli_held_tie(struct ndli_site *site, const ndli_bed_row *row, struct ndli_hold *hold)
{
    hold->count = row->count;
    for (int a = 0; a < row->count; a++) {
        hold->places[a] = ndli_held_number(site, row->nodes[a]);
        hold->weights[a] = row->weights[a];
    }
}

/* What a way is beyond what friction winds up (m). */
static double ndli_held_beyond(double way, double slack) { return way - fmin(fmax(way, -slack), slack); }

/* How far hold i is ahead of the material at an arc, beyond what friction winds up there (m). */
static double ndli_held_ahead(const ndl_needle *needle, int i, double arc)
{
    ndli_held_spot spot;
    ndli_v3 way;
    if (!ndli_held_find(needle, arc, &spot))
        return 0;
    way = ndli_sub(ndli_held_place(needle, i), ndli_bed_at(&needle->site->bed, &spot.row));
    return ndli_held_beyond(ndli_dot(ndli_held_tangent(needle->rod, i), way), ndli_held_slack(needle, &spot));
}

/* A slip of an inner hold by `slip` (m at rest) goes past where the shaft is: a cut is within it, which stands open,
 * and the shaft is between the lips. It stays at the one where it is held until it has come to the other. Held at each
 * in turn it would be pushed to and fro for ever. */
static int ndli_held_is_between_lips(const ndl_needle *needle, int i, double slip)
{
    double arc = fmin(fmax(needle->arc[i] + slip, 0), ndli_held_most_arc(needle, i));
    return slip != 0 && sbi_body_has_pieces(needle->site->body) && ndli_held_ahead(needle, i, arc) * slip < 0;
}

/* Slip that a hold cannot make: where the shaft goes in it stays at the skin, and where soft tissue is so much pressed
 * before the tip that more of the shaft would be past it than there is on the track, it stays behind the next. What it
 * is ahead of the tissue beyond what friction can wind up is then of steps before: taken for a slip of this one, and
 * again in each, viscosity made a force of it (0.2 N beyond friction and cutting were seen). */
static double ndli_held_overrun(const ndl_needle *needle, int i, const ndli_held_spot *spot, ndli_v3 tangent,
                                ndli_v3 offset)
{
    double wound = ndli_dot(tangent, offset), slack, room, ahead;
    if (i == ndli_line_foremost(&needle->line))
        return 0;
    slack = ndli_held_slack(needle, spot);
    ahead = ndli_held_beyond(wound, slack);
    if (i < needle->line.first || ndli_held_is_between_lips(needle, i, ahead / spot->stretch))
        return ahead;
    room = spot->stretch * fmax(0, ndli_held_most_arc(needle, i) - needle->arc[i]);
    return fmax(0, wound - slack - room);
}

/* N/m along hold i, `length` of shaft. */
static double ndli_held_stiffness(const ndl_needle *needle, int i, double length, const ndli_held_tissue *tissue)
{
    int is_tip = i == ndli_line_foremost(&needle->line);
    return length * ndli_held_along(tissue) + (is_tip ? ndli_held_tip(needle, tissue) : 0);
}

/* Hold i where it is now, `length` of shaft; *spot: where its material is. */
static void ndli_held_make(ndl_needle *needle, int i, double length, ndli_held_spot *spot)
{
    struct ndli_hold *hold = needle->line.holds + i;
    const ndl_rod *rod = needle->rod;
    ndli_held_tissue tissue;
    int is_tip = i == ndli_line_foremost(&needle->line), there = ndli_held_find(needle, ndli_held_arc(needle, i), spot);
    memset(hold, 0, sizeof *hold);
    if (i < needle->line.first)
        hold->share = 1 - needle->entering / ndli_held_edge(rod, i);
    hold->tangent = hold->share > 0 ? rod->tangent[i] : ndli_held_tangent(rod, i);
    needle->stretch[i] = spot->stretch;
    if (!there || !(length > 0 || is_tip))
        return;
    ndli_held_tie(needle->site, &spot->row, hold);
    hold->offset = ndli_sub(ndli_held_place(needle, i), ndli_bed_at(&needle->site->bed, &spot->row));
    tissue = ndli_held_get_tissue(needle, spot->place.element, &spot->row);
    hold->offset =
        ndli_madd(hold->offset, -ndli_held_overrun(needle, i, spot, hold->tangent, hold->offset), hold->tangent);
    hold->length = length;
    hold->across = length * ndli_held_across(&tissue);
    hold->along = ndli_held_stiffness(needle, i, length, &tissue);
}

NDLI_API void ndli_held_forget(struct ndli_site *site)
{
    for (int k = 0; k < site->coupled_count; k++)
        site->node_place[site->coupled[k]] = -1;
    site->coupled_count = 0;
}

/* ---- what the tissue does to a needle ---- */

static void ndli_held_resist_tip(ndl_needle *needle, const ndli_bed_row *row, double table)
{
    ndli_line *line = &needle->line;
    const ndli_bed *bed = &needle->site->bed;
    const ndli_track *track = &needle->track;
    ndli_track_point end = ndli_track_at(track, ndli_track_length(track));
    ndli_v3 ahead = ndli_madd(end.X, 0.2 * needle->site->mean_edge, needle->heading);
    ndli_place place;
    int last = ndli_line_foremost(line);
    if (!row->count) /* there is nothing in a hole */
        return;
    line->cutting = ndli_needle_cutting_at(needle, ndli_to(end.X), ndli_bed_region(bed, row), table);
    if (needle->hold_steps == 0 && ndli_bed_locate(bed, ndli_to(ahead), end.element, &place))
        return;
    needle->blocked = 1;
    line->cutting = (double)SB_REAL_MAX;
    if (line->state[last] == NDL_DYNAMIC_FORWARD)
        line->state[last] = NDL_STATIC;
}

NDLI_API void ndli_held_resist(ndl_needle *needle)
{
    ndl_rod *rod = needle->rod;
    ndli_line *line = &needle->line;
    int last = ndli_line_foremost(line), first = ndli_line_rearmost(line);
    line->cutting = 0;
    ndli_held_measure_entering(needle);
    for (int j = 0; j < sbi_min_int(first, rod->node_count - 1); j++)
        ndl_rod_set_grip(rod, j, 0, 0);
    for (int i = first; i <= last; i++) {
        double length = ndli_held_length(needle, i), edge;
        ndl_friction friction;
        ndli_held_spot spot;
        ndli_held_make(needle, i, length, &spot);
        friction = ndli_held_friction(needle, &spot.row);
        line->friction[i] = length * (double)friction.friction;
        line->viscous[i] = length * (double)friction.viscous;
        if (i == last) {
            ndli_held_resist_tip(needle, &spot.row, (double)friction.cutting);
            continue;
        }
        edge = i < line->first ? needle->entering : ndli_held_edge(rod, i);
        ndl_rod_set_grip(rod, i, (sb_real)(edge * (double)friction.twist_stiffness),
                         (sb_real)(edge * (double)friction.twist_friction));
    }
}

/* ---- the tip goes on ---- */

enum { NDLI_HELD_HOLD_STEPS = 8 };

static ndli_v3 ndli_held_unit(ndli_v3 v) { return ndli_scale(1 / ndli_norm(v), v); }

/* In space, of what is cut along the shaft's last edge to the material at `end`; heading where there is no such edge.
 */
static ndli_v3 ndli_held_chord(const ndl_needle *needle, ndli_v3 end, ndli_v3 heading)
{
    ndli_held_spot spot;
    ndli_v3 chord;
    int before = needle->rod->node_count - 2;
    if (before < needle->line.first || !ndli_held_find(needle, needle->arc[before], &spot))
        return heading;
    chord = ndli_sub(end, ndli_bed_at(&needle->site->bed, &spot.row));
    return ndli_dot(chord, heading) > 0 ? ndli_held_unit(chord) : heading;
}

/* The tip has nowhere to go: it is held for a while. */
static void ndli_held_block(ndl_needle *needle)
{
    needle->blocked = 1;
    needle->hold_steps = NDLI_HELD_HOLD_STEPS;
}

/* A point on the way, `ahead` (m at rest) of its end, or behind it. 0: before the skin. */
static int ndli_held_beside(const ndl_needle *needle, double ahead, ndli_track_point *point)
{
    const ndli_track *track = &needle->track;
    double length = ndli_track_length(track);
    *point = ndli_track_at(track, length + fmin(ahead, 0));
    if (ahead > 0)
        point->X = ndli_madd(point->X, ahead, needle->heading);
    return length + ahead >= 0;
}

/* Deformation gradient about the tip, at place: the mean along its way, over the length of the shaft's bends. In one
 * element at the end of a load it has no limit as meshes get finer. */
static sb_mat3 ndli_held_gradient(const ndl_needle *needle, const ndli_place *place, const ndli_bed_row *row)
{
    const ndli_bed *bed = &needle->site->bed;
    sb_mat3 sum = ndli_bed_gradient(bed, place, row);
    int count = 1;
    for (int k = -2; k <= 2; k++) {
        ndli_track_point point;
        ndli_place there;
        ndli_bed_row other;
        if (k == 0 || !ndli_held_beside(needle, 0.25 * k * needle->wave, &point) ||
            !ndli_bed_locate(bed, ndli_to(point.X), point.element, &there) || !ndli_bed_row_at(bed, &there, &other))
            continue;
        sum = sb_m3_add(sum, ndli_bed_gradient(bed, &there, &other));
        count++;
    }
    return sb_m3_scale(1 / (sb_real)count, sum);
}

/* The material that is at x in space, by Newton's method from *X on. 0: none is near; where *X and *place have come to
 * was taken away, or is outside. */
static int ndli_held_material(const ndli_bed *bed, ndli_v3 x, ndli_v3 *X, ndli_place *place)
{
    const double enough = 1e-6 * bed->mean_edge;
    for (int round = 0; round < 20; round++) {
        ndli_bed_row row;
        ndli_v3 off;
        sb_mat3 f;
        if (!ndli_bed_locate(bed, ndli_to(*X), place->element, place) || !ndli_bed_row_at(bed, place, &row))
            return 0;
        off = ndli_sub(x, ndli_bed_at(bed, &row));
        if (ndli_norm(off) < enough)
            return 1;
        f = ndli_bed_gradient(bed, place, &row);
        if (!(sb_m3_det(f) > 0))
            return 0;
        *X = ndli_add(*X, ndli_from(sb_m3_apply(sb_m3_inverse(f), ndli_to(off))));
    }
    return 0;
}

/* How many places before a tip in a hole are looked at, and how far they are apart in edges of the tissue: tissue is
 * drawn along by less than their way. */
enum { NDLI_HELD_LOOKS = 40 };
static const double ndli_held_look = 0.1;

/* The wall that a tip in a hole, or out of one on the far side, has come to, as it is in space: *X, *place. 0: to none.
 */
static int ndli_held_meet_wall(const ndl_needle *needle, const ndli_track_point *end, ndli_v3 *X, ndli_place *place)
{
    const ndli_bed *bed = &needle->site->bed;
    const ndl_rod *rod = needle->rod;
    ndli_bed_row row;
    int element = end->element;
    for (int k = 1; k <= NDLI_HELD_LOOKS; k++, element = place->element) {
        *X = ndli_madd(end->X, k * ndli_held_look * bed->mean_edge, needle->heading);
        if (ndli_bed_find(bed, ndli_to(*X), element, place, &row))
            return ndli_held_material(bed, rod->x[rod->node_count - 1], X, place);
    }
    return 0;
}

/* Where the tip looks, at rest, in the material at a place; as it is where there is none. 0: that is turned inside out.
 */
static int ndli_held_look_ahead(ndl_needle *needle, const ndli_place *place)
{
    const ndli_bed *bed = &needle->site->bed;
    ndli_v3 tangent = needle->rod->tangent[needle->rod->node_count - 2];
    ndli_bed_row row;
    sb_mat3 f = ndli_bed_row_at(bed, place, &row) ? ndli_bed_gradient(bed, place, &row) : sb_m3_identity();
    if (!(sb_m3_det(f) > 0))
        return 0;
    needle->heading = ndli_held_unit(ndli_from(sb_m3_apply(sb_m3_inverse(f), ndli_to(tangent))));
    return 1;
}

/* Where material was taken away a tip goes straight on, out of the far side too, until it comes to a wall. */
static void ndli_held_go_through_hole(ndl_needle *needle, double advance, const ndli_track_point *end)
{
    const ndli_bed *bed = &needle->site->bed;
    ndli_v3 X, tip = needle->rod->x[needle->rod->node_count - 1];
    ndli_place place;
    ndli_bed_row row;
    int meets = ndli_held_meet_wall(needle, end, &X, &place);
    if (!meets) {
        X = ndli_madd(end->X, advance, needle->heading);
        if (ndli_bed_find(bed, ndli_to(X), end->element, &place,
                          &row)) /* where the wall was before it was drawn along */
            (void)ndli_held_material(bed, tip, &X, &place);
        (void)ndli_bed_locate(bed, ndli_to(X), place.element, &place);
    }
    if ((meets && !ndli_held_look_ahead(needle, &place)) || !ndli_track_extend(&needle->track, X, place.element))
        ndli_held_block(needle);
}

/* The track goes on by `advance` (m, in space) from where the tip is. */
static void ndli_held_cut(ndl_needle *needle, double advance)
{
    const ndli_bed *bed = &needle->site->bed;
    ndli_track *track = &needle->track;
    ndli_track_point end = ndli_track_at(track, ndli_track_length(track));
    ndli_v3 heading, shaft, way, X, gap;
    ndli_bed_row row, next;
    ndli_place place;
    sb_mat3 f, inverse;
    int there;
    if (!ndli_bed_find(bed, ndli_to(end.X), end.element, &place, &row)) {
        ndli_held_go_through_hole(needle, advance, &end);
        return;
    }
    f = ndli_held_gradient(needle, &place, &row);
    if (!(sb_m3_det(f) > 0)) {
        ndli_held_block(needle);
        return;
    }
    inverse = sb_m3_inverse(f);
    heading = ndli_held_unit(ndli_from(sb_m3_apply(f, ndli_to(needle->heading))));
    shaft = ndli_bevel_shaft(needle, heading, ndli_held_chord(needle, ndli_bed_at(bed, &row), heading));
    way = ndli_bevel_go(needle, advance, shaft, ndli_bevel_lag(&needle->bevel), &heading);
    X = ndli_add(end.X, ndli_from(sb_m3_apply(inverse, ndli_to(way))));
    if (!ndli_bed_locate(bed, ndli_to(X), place.element, &place)) {
        ndli_held_block(needle);
        return;
    }
    there = ndli_bed_row_at(bed, &place, &next); /* else it comes into a hole */
    gap = there ? ndli_sub(ndli_sub(ndli_bed_at(bed, &next), ndli_bed_at(bed, &row)), way) : ndli_v(0, 0, 0);
    if (there && ndli_norm(gap) > advance + 0.1 * needle->site->mean_edge) { /* a cut lies between, and stands open */
        ndli_held_block(needle);
        return;
    }
    if (!ndli_track_extend(track, X, place.element)) {
        needle->limited = 1;
        ndli_held_block(needle);
        return;
    }
    needle->heading = ndli_held_unit(ndli_from(sb_m3_apply(inverse, ndli_to(heading))));
}

/* The tip goes back along the track, and looks along it again. */
static void ndli_held_draw_back(ndl_needle *needle, double arc)
{
    ndli_track_shorten(&needle->track, fmax(arc, 0));
    needle->hold_steps = 0;
    if (needle->track.count > 1)
        needle->heading = ndli_track_at(&needle->track, ndli_track_length(&needle->track)).tangent;
}

NDLI_API void ndli_held_leave(ndl_needle *needle)
{
    needle->line.first = needle->rod->node_count;
    needle->line.count = 0;
    needle->track.count = 0;
    needle->entering = 0;
}

/* Nodes that have come in, or gone out again. */
static void ndli_held_count(ndl_needle *needle)
{
    ndli_line *line = &needle->line;
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1;
    double stretch, more;
    while (line->first < last && needle->arc[line->first] <= 0) {
        line->state[line->first - 1] = NDL_FREE;
        line->first++;
    }
    while (line->first > 2 && (more = ndli_held_reach(needle, &stretch) - ndli_held_edge(rod, line->first - 1)) > 0) {
        int next = line->first - 1;
        double arc = fmin(more / stretch, ndli_held_most_arc(needle, next));
        if (!(arc > 0)) /* the rod is ahead of its material by more than it is in */
            break;
        line->first = next;
        needle->arc[next] = arc;
        line->state[next - 1] = line->state[next];
        line->contact[next - 1] = ndli_v(0, 0, 0);
    }
    line->count = rod->node_count - line->first;
    ndli_held_measure_entering(needle);
}

/* How far hold i is ahead of its material (m), or behind, only because it has slipped into stiffer tissue, to an arc:
 * there the force that holds it takes less of a way, and by the rest it has gone on, too. Taken for a slip of the next
 * step that would be as fast as the step is short, and viscosity made a force of it (0.8 N at a prostate's capsule). */
static double ndli_held_excess(const ndl_needle *needle, int i, double arc)
{
    const struct ndli_hold *hold = needle->line.holds + i;
    ndli_held_spot spot;
    ndli_held_tissue tissue;
    double ahead, along;
    if (hold->count == 0 || needle->line.state[i] == NDL_STATIC || !ndli_held_find(needle, arc, &spot))
        return 0;
    tissue = ndli_held_get_tissue(needle, spot.place.element, &spot.row);
    along = ndli_held_stiffness(needle, i, hold->length, &tissue);
    ahead = ndli_dot(hold->tangent, ndli_sub(ndli_held_place(needle, i), ndli_bed_at(&needle->site->bed, &spot.row)));
    return ahead * needle->line.slip[i] > 0 ? ahead * fmax(0, 1 - hold->along / along) : 0;
}

/* The tip goes on by `advance` (m, > 0). */
static void ndli_held_go_on(ndl_needle *needle, double advance)
{
    double excess;
    ndli_held_cut(needle, advance);
    excess = ndli_held_excess(needle, ndli_line_foremost(&needle->line), ndli_track_length(&needle->track));
    if (excess > 0)
        ndli_held_cut(needle, excess);
}

/* Nodes come to where they have slipped to; none passes the next. */
static void ndli_held_slip(ndl_needle *needle)
{
    const ndli_line *line = &needle->line;
    int last = ndli_line_foremost(line);
    needle->arc[last] = ndli_track_length(&needle->track);
    for (int i = last - 1; i >= line->first; i--) {
        double slip = line->slip[i] / needle->stretch[i];
        if (!ndli_held_is_between_lips(needle, i, slip))
            needle->arc[i] += slip + ndli_held_excess(needle, i, needle->arc[i] + slip) / needle->stretch[i];
        needle->arc[i] = fmin(needle->arc[i], ndli_held_most_arc(needle, i));
    }
}

/* ---- a needle that has torn out is held again ---- */

/* Where the shaft comes in through the skin that goes on to the tip: on edge *j, at *at; *place: of the skin there.
 * Returns what is behind it up to the tip (m); negative: it comes in nowhere. */
static double ndli_held_behind(const ndl_needle *needle, int *j, ndli_place *place, sb_vec3 *at)
{
    const ndl_rod *rod = needle->rod;
    double behind = 0;
    for (*j = rod->node_count - 2; *j > 0; (*j)--) {
        if (ndli_bed_hit(&needle->site->bed, ndli_to(rod->x[*j]), ndli_to(rod->x[*j + 1]), place, at))
            return behind + ndli_norm(ndli_sub(rod->x[*j + 1], ndli_from(*at)));
        behind += ndli_held_edge(rod, *j);
    }
    return -1;
}

/* The track is where the shaft is from the skin at edge j, so that the tissue is held without any force. 0: it cannot
 * be followed. */
static int ndli_held_lay_track(ndl_needle *needle, int j, ndli_place place)
{
    const ndl_rod *rod = needle->rod;
    const ndli_bed *bed = &needle->site->bed;
    ndli_track *track = &needle->track;
    ndli_v3 X = ndli_from(sbi_embed_map(&bed->mesh, place.element, place.xi, NULL));
    ndli_track_begin(track, X, place.element);
    for (int i = j + 1; i < rod->node_count; i++) {
        if (!ndli_held_material(bed, rod->x[i], &X, &place) || !ndli_track_extend(track, X, place.element))
            return 0;
        needle->arc[i] = ndli_track_length(track);
    }
    return track->count > 1;
}

/* Once it is half an edge deep, which is how deep no needle tears out again at once. */
static void ndli_held_thread(ndl_needle *needle)
{
    ndl_rod *rod = needle->rod;
    ndli_line *line = &needle->line;
    ndli_place place;
    sb_vec3 at;
    int j;
    if (ndli_held_behind(needle, &j, &place, &at) < 0.5 * needle->site->mean_edge)
        return;
    if (!ndli_held_lay_track(needle, j, place)) {
        ndli_held_leave(needle);
        return;
    }
    needle->heading = ndli_track_at(&needle->track, ndli_track_length(&needle->track)).tangent;
    needle->lost = NDLI_LOST_NOT;
    line->first = j + 1;
    line->count = rod->node_count - line->first;
    for (int i = j; i < rod->node_count; i++) {
        line->state[i] = NDL_STATIC;
        line->contact[i] = ndli_v(0, 0, 0);
        line->slip[i] = 0;
    }
    ndli_held_measure_entering(needle);
}

/* ---- the tip comes in ---- */

static void ndli_held_enter(ndl_needle *needle)
{
    const ndl_rod *rod = needle->rod;
    const ndli_bed *bed = &needle->site->bed;
    int last = rod->node_count - 1;
    ndli_line *line = &needle->line;
    ndli_place place;
    sb_vec3 at, X;
    int hits = ndli_bed_hit(bed, ndli_to(rod->x[last - 1]), ndli_to(rod->x[last]), &place, &at);
    if (needle->lost) { /* it is in the tissue, which does not hold it */
        if (!hits && !ndli_bed_holds_in_space(bed, ndli_to(rod->x[last])))
            needle->lost = NDLI_LOST_NOT;
        else if (needle->lost == NDLI_LOST_TORN)
            ndli_held_thread(needle);
        return;
    }
    if (!hits || !ndli_held_look_ahead(needle, &place))
        return;
    X = sbi_embed_map(&bed->mesh, place.element, place.xi, NULL);
    ndli_track_begin(&needle->track, ndli_from(X), place.element);
    line->first = last;
    line->count = 1;
    needle->arc[last] = 0;
    line->state[last] = line->state[last - 1] = NDL_STATIC;
    line->contact[last] = line->contact[last - 1] = ndli_v(0, 0, 0);
}

NDLI_API void ndli_held_follow_tip(ndl_needle *needle)
{
    ndli_line *line = &needle->line;
    int last = ndli_line_foremost(line);
    double back;
    needle->advance = 0;
    if (line->count == 0) {
        ndli_held_enter(needle);
        return;
    }
    needle->advance = line->slip[last];
    back = needle->arc[last] + needle->advance / needle->stretch[last];
    if (needle->advance > 0)
        ndli_held_go_on(needle, needle->advance);
    else if (needle->advance < 0)
        ndli_held_draw_back(needle, back);
    if (!(back > 0) && needle->advance < 0) {
        ndli_held_leave(needle);
        return;
    }
    ndli_held_slip(needle);
    ndli_held_count(needle);
}

/* ==== src/needle/needle_tip.c ==== */
/* needle_tip: where a needle's tip cuts to, and the mesh that follows it there. */
#include <string.h>


/* ---- where the path looks ---- */

/* Deformation gradient about a tissue node: the mean over its tets, by volume. */
static sb_mat3 ndli_tip_gradient(const ndli_topology *mesh, int node)
{
    sb_mat3 sum = sb_m3_zero();
    sb_real total = 0;
    for (int k = mesh->node_star[node]; k >= 0; k = mesh->corner_next[k]) {
        sb_real volume = mesh->volumes[k / 4];
        sum = sb_m3_add(sum, sb_m3_scale(volume, ndli_topology_gradient(mesh, k / 4)));
        total += volume;
    }
    return sb_m3_scale(1 / total, sum);
}

static ndli_v3 ndli_tip_unit(ndli_v3 v) { return ndli_scale(1 / ndli_norm(v), v); }

static ndli_v3 ndli_tip_mapped(const sb_mat3 *f, ndli_v3 v) { return ndli_from(sb_m3_apply(*f, ndli_to(v))); }

NDLI_API ndli_v3 ndli_needle_heading(const ndl_needle *needle)
{
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1;
    ndli_v3 t = rod->tangent[last - 1], ahead;
    sb_mat3 f;
    if (needle->site->embeds || needle->shallow || needle->line.count == 0)
        return t;
    f = ndli_tip_gradient(needle->site->mesh, needle->path[needle->line.count - 1]);
    ahead = ndli_tip_mapped(&f, needle->heading);
    return ndli_dot(ahead, t) > 0 ? ndli_tip_unit(ahead) : t;
}

/* How far the way may be from the last edge (rad): a chord lags by half its arc's turn, where it is longer than the
 * shaft's bends, and remeshing moves its nodes. By NDL_BEVEL_CURVATURE that is all there is to it. */
static double ndli_tip_lag(const ndl_needle *needle)
{
    double length = fmax(needle->rod->rest_length[needle->rod->node_count - 2], needle->site->mean_edge);
    double curvature = fabs(ndli_bevel_curvature(&needle->bevel)), lag = ndli_bevel_lag(&needle->bevel);
    if (needle->bevel.law == NDL_BEVEL_CURVATURE)
        return 2 * curvature * length;
    return lag + (1 - fmin(needle->wave / length, 1)) * 2 * fmin(curvature, lag / needle->wave) * length;
}

/* In the material, how far aside a bevel puts the tip that has advanced along the last edge; the needle's heading turns
 * with it. node: of the mesh, about which. */
static ndli_v3 ndli_tip_aside(ndl_needle *needle, int node)
{
    sb_mat3 f = ndli_tip_gradient(needle->site->mesh, node), inverse;
    ndli_v3 t = needle->rod->tangent[needle->rod->node_count - 2], heading, way;
    if (!(sb_m3_det(f) > 0) || !(needle->advance > 0))
        return ndli_v(0, 0, 0);
    inverse = sb_m3_inverse(f);
    heading = ndli_tip_unit(ndli_tip_mapped(&f, needle->heading));
    way = ndli_bevel_go(needle, needle->advance, t, ndli_tip_lag(needle), &heading);
    needle->heading = ndli_tip_unit(ndli_tip_mapped(&inverse, heading));
    return ndli_tip_mapped(&inverse, ndli_madd(way, -ndli_dot(way, t), t));
}

/* Along the shaft, about the entry. */
static ndli_v3 ndli_tip_straight(const ndl_needle *needle, int entry)
{
    ndli_v3 t = needle->rod->tangent[needle->rod->node_count - 2];
    sb_mat3 f = ndli_tip_gradient(needle->site->mesh, entry);
    if (!(sb_m3_det(f) > 0))
        return t;
    f = sb_m3_inverse(f);
    return ndli_tip_unit(ndli_tip_mapped(&f, t));
}

/* The way of a tip that has just come in. */
static void ndli_tip_begin(ndl_needle *needle)
{
    int count;
    const int *path = ndl_remesh_nodes(needle->site->remesh, needle->index, &count);
    needle->aside = ndli_v(0, 0, 0);
    needle->enters = 1;
    if (count > 0)
        needle->heading = ndli_tip_straight(needle, path[0]);
}

/* A shallow tip goes on, or back, to `depth` (m): its way bends from the skin on, before it has a node. */
static void ndli_tip_go_shallow(ndl_needle *needle, double depth)
{
    int entry = needle->path[0];
    if (needle->advance > 0) {
        needle->aside = ndli_add(needle->aside, ndli_tip_aside(needle, entry));
        return;
    }
    needle->aside = ndli_scale(depth / (depth - needle->advance), needle->aside);
    needle->heading = ndli_tip_unit(ndli_madd(ndli_tip_straight(needle, entry), 2 / depth, needle->aside));
}

/* The heading of the path that is there: that of the circle through its last three nodes. */
static void ndli_tip_take_heading(ndl_needle *needle)
{
    const ndli_topology *mesh = needle->site->mesh;
    ndli_v3 last, before;
    double l, b;
    int count;
    const int *path = ndl_remesh_nodes(needle->site->remesh, needle->index, &count);
    if (count < 2)
        return;
    last = ndli_from(sb_v3_sub(mesh->X[path[count - 1]], mesh->X[path[count - 2]]));
    l = ndli_norm(last);
    needle->heading = ndli_scale(1 / l, last);
    if (count < 3)
        return;
    before = ndli_from(sb_v3_sub(mesh->X[path[count - 2]], mesh->X[path[count - 3]]));
    b = ndli_norm(before);
    needle->heading =
        ndli_tip_unit(ndli_madd(needle->heading, l / (l + b), ndli_sub(needle->heading, ndli_scale(1 / b, before))));
}

/* ---- the mesh follows ---- */

enum { NDLI_HOLD_STEPS = 8 };

/* A tip that the remesher cannot follow stays behind and is held for a while, so that the needle does not go on without
 * it; a collision with another needle is the step's failure, but for a needle that is not pushed: tissue that moves, or
 * a shaft that straightens, must not keep it from being drawn back. */
static sb_result ndli_tip_judge(ndl_needle *needle, sb_result result, sb_error *own, sb_error *error)
{
    if (result == SB_OK)
        return SB_OK;
    needle->blocked = 1;
    needle->hold_steps = NDLI_HOLD_STEPS;
    if (result == SB_ERROR_MESH || result == SB_ERROR_MEMORY || (result == SB_ERROR_UNSUPPORTED && !needle->pushed))
        return SB_OK;
    if (error)
        *error = *own;
    return result;
}

static sb_result ndli_tip_enter(ndl_needle *needle, ndl_remesh_info *done, sb_error *error)
{
    ndl_remesh *remesh = needle->site->remesh;
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1;
    ndl_surface_hit hit;
    sb_error own;
    sb_result result;
    if (!ndli_topology_hit(needle->site->mesh, ndli_to(rod->x[last - 1]), ndli_to(rod->x[last]), &hit))
        return SB_OK;
    result = ndli_remesh_puncture_within(remesh, needle->index, &hit, needle->entry_slip, done, &own);
    ndli_tip_begin(needle);
    return ndli_tip_judge(needle, result, &own, error);
}

/* Depths (m) at which a tip gets a node of its own, and loses it; it loses it from the first of them on where tets
 * about it are worse than would do to get one. */
static double ndli_tip_deep(const ndl_needle *needle) { return 0.5 * needle->site->mean_edge; }
static double ndli_tip_shallow(const ndl_needle *needle) { return 0.4 * needle->site->mean_edge; }

/* Quality of tets with which it gets one: the deeper it is, the less is asked for. */
static sb_real ndli_tip_enough(const ndl_needle *needle, double depth)
{
    double share = depth / ndli_tip_deep(needle);
    return share < 2 ? (sb_real)(0.3 * (2 - share)) : 0;
}

/* Gives the tip its first node below the entry, at X, or on the way there when that cannot be done in one operation
 * without flat tets: many small ones would leave worse. Below skin that was pushed in X is so far that no tet about the
 * entry may come near half of the way: then places nearer to it are tried. (Not else: pushed-in skin has distorted the
 * tets there, and a node in them does not lie on the needle.) */
static sb_result ndli_tip_sink(ndl_needle *needle, double depth, sb_vec3 X, ndl_remesh_info *done)
{
    sb_real enough = ndli_tip_enough(needle, depth);
    ndl_remesh *remesh = needle->site->remesh;
    sb_vec3 entry = needle->site->mesh->X[needle->path[0]], way = sb_v3_sub(X, entry);
    double length = (double)sb_v3_norm(way), least = 0.5 * ndli_tip_deep(needle);
    sb_result result = SB_ERROR_MESH;
    int found = 0;
    for (int part = 8; result == SB_ERROR_MESH && (part >= 4 || (!found && part * length >= 8 * least));
         part -= part > 4 ? 2 : 1) {
        sb_vec3 to = sb_v3_madd(entry, (sb_real)part / 8, way);
        result = ndli_remesh_put_first(remesh, needle->index, to, enough, done);
        found |= done->candidates > 0;
    }
    return result;
}

/* Where the tip is to get nodes of its own: about the entry its bend was measured. */
static void ndli_tip_land(ndl_needle *needle, int entry)
{
    sb_mat3 f = ndli_tip_gradient(needle->site->mesh, entry);
    needle->sinks = 1;
    needle->landing = ndli_add(needle->rod->x[needle->rod->node_count - 1], ndli_tip_mapped(&f, needle->aside));
}

/* The tip of a shallow needle: it goes on without the mesh, gets a node when it is deep enough, or leaves. */
static sb_result ndli_tip_cut_shallow(ndl_needle *needle, ndl_remesh_info *done, sb_error *error)
{
    ndl_remesh *remesh = needle->site->remesh;
    const ndli_topology *mesh = needle->site->mesh;
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1, entry = needle->path[0];
    ndli_v3 from = ndli_add(ndli_from(mesh->x[entry]), needle->gap[needle->line.first]);
    double depth = ndli_dot(ndli_sub(rod->x[last], from), rod->tangent[last - 1]);
    ndl_remesh_info sunk;
    sb_vec3 X;
    sb_error own;
    sb_result result;
    if (depth < 0)
        return ndl_remesh_withdraw(remesh, needle->index, done, error);
    if (depth > 0)
        ndli_tip_go_shallow(needle, depth);
    if (depth < ndli_tip_deep(needle) || needle->hold_steps > 0)
        return SB_OK;
    ndl_remesh_material_point(remesh, needle->index, ndli_to(rod->x[last]), &X);
    ndli_tip_land(needle, entry);
    X = sb_v3_add(X, ndli_to(needle->aside));
    result = ndli_tip_sink(needle, depth, X, &sunk);
    if (result == SB_ERROR_MESH && depth < 2 * ndli_tip_deep(needle))
        return SB_OK; /* better when it is deeper */
    if (result != SB_OK)
        memset(&sunk, 0, sizeof sunk);
    result = ndl_remesh_penetrate(remesh, needle->index, X, done, &own);
    done->substeps += sunk.substeps;
    done->candidates += sunk.candidates;
    done->smoothed += sunk.smoothed;
    done->released += sunk.released;
    needle->reaches = result == SB_OK && !done->outside;
    if (result != SB_OK) /* the first operations may have been done */
        ndli_tip_take_heading(needle);
    return ndli_tip_judge(needle, result, &own, error);
}

static int ndli_tip_is_shallow(const ndl_needle *needle, double depth, sb_real quality)
{
    return depth < ndli_tip_shallow(needle) ||
           (depth < ndli_tip_deep(needle) && quality < ndli_tip_enough(needle, depth));
}

/* A tip that has come back near the skin loses its node: the mesh is that of a first contact again. quality: of tets
 * about it */
static void ndli_tip_make_shallow(ndl_needle *needle, sb_real quality)
{
    ndl_remesh *remesh = needle->site->remesh;
    const ndli_topology *mesh = needle->site->mesh;
    const ndl_rod *rod = needle->rod;
    int first = needle->line.first, count;
    const int *path = ndl_remesh_nodes(remesh, needle->index, &count);
    double back = needle->site->mean_edge;
    sb_vec3 entry;
    ndl_surface_hit hit;
    if (count < 2 || !ndli_tip_is_shallow(
                         needle, (double)sb_v3_norm(sb_v3_sub(mesh->X[path[count - 1]], mesh->X[path[0]])), quality))
        return;
    entry = mesh->x[path[0]];
    if (ndl_remesh_withdraw(remesh, needle->index, NULL, NULL) != SB_OK)
        return; /* it stays as it is */
    if (ndli_topology_hit(mesh, sb_v3_madd(entry, (sb_real)-back, ndli_to(rod->tangent[first - 1])),
                          ndli_to(rod->x[rod->node_count - 1]), &hit))
        (void)ndli_remesh_puncture_within(remesh, needle->index, &hit, needle->entry_slip, NULL,
                                          NULL); /* without success it is out: a little early */
    ndli_tip_begin(needle);
}

/* The tip goes back to X. It always gets out: where remeshing does not find a way, or another needle's element is in
 * it, the needle is stretched until its tip would be outside. */
static sb_result ndli_tip_draw_back(ndl_needle *needle, sb_vec3 X, int inside, ndl_remesh_info *done, sb_error *error)
{
    ndl_remesh *remesh = needle->site->remesh;
    sb_result result = ndl_remesh_retract(remesh, needle->index, X, done, NULL);
    needle->hold_steps = 0;
    needle->reaches = result == SB_OK;
    needle->blocked = result != SB_OK && inside;
    if (result != SB_OK && !inside)
        return ndl_remesh_withdraw(remesh, needle->index, done, error);
    ndli_tip_take_heading(needle);
    ndli_tip_make_shallow(needle, result == SB_OK ? done->worst_quality : 1);
    return SB_OK;
}

static sb_result ndli_tip_cut_deep(ndl_needle *needle, ndl_remesh_info *done, sb_error *error)
{
    ndl_remesh *remesh = needle->site->remesh;
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1, inside;
    sb_vec3 X; /* where the tip cuts to, first straight on */
    sb_error own;
    sb_result result;
    inside = ndl_remesh_material_point(remesh, needle->index, ndli_to(rod->x[last]), &X);
    if (needle->advance < 0) /* where states came out inconsistent its sign, not the state's, counts */
        return ndli_tip_draw_back(needle, X, inside, done, error);
    X = sb_v3_add(X, ndli_to(ndli_tip_aside(needle, needle->path[needle->line.count - 1])));
    result = ndl_remesh_penetrate(remesh, needle->index, X, done, &own);
    if (result == SB_OK && done->outside)
        result = sbi_fail(&own, SB_ERROR_MESH, "the tip would leave the tissue");
    needle->reaches = result == SB_OK;
    return ndli_tip_judge(needle, result, &own, error);
}

NDLI_API sb_result ndli_needle_follow_tip(ndl_needle *needle, ndl_remesh_info *done, sb_error *error)
{
    needle->advance = 0;
    needle->enters = needle->sinks = needle->reaches = 0;
    needle->follows = 1;
    for (int k = 0; k < needle->line.count; k++)
        needle->old_X[k] = needle->site->mesh->X[needle->path[k]];
    if (needle->line.count == 0)
        return ndli_tip_enter(needle, done, error);
    needle->advance = needle->line.slip[ndli_line_foremost(&needle->line)];
    if (needle->advance == 0)
        return SB_OK;
    return needle->shallow ? ndli_tip_cut_shallow(needle, done, error) : ndli_tip_cut_deep(needle, done, error);
}

/* ==== src/needle/needle_nodes.c ==== */
/* needle_nodes: which nodes a rod has. In the tissue those of the remesher's path, outside enough for its bends: they
 * slide along with the needle, and are dropped where they come close to the sleeve or the skin, and made where it gets
 * empty. */

#include <string.h>

/* Outside of the tissue edges are between these parts of edge_length: far enough apart that a node made by one rule is
 * not at once the other's. */
static double ndli_nodes_shortest(const ndl_needle *needle) { return 0.5 * needle->edge_length; }
static double ndli_nodes_longest(const ndl_needle *needle) { return 2 * needle->edge_length; }

static ndli_v3 ndli_nodes_tangent(const ndl_rod *rod, int i)
{
    ndli_v3 before = rod->tangent[sbi_max_int(i - 1, 0)], after = rod->tangent[sbi_min_int(i, rod->node_count - 2)];
    ndli_v3 sum = ndli_add(before, after);
    return ndli_scale(1 / ndli_norm(sum), sum);
}

/* The new list while it grows; the last place is for the entry or the tip. */
typedef struct ndli_places {
    ndli_v3 *x, *tangent;
    int count, capacity;
} ndli_places;

static void ndli_nodes_put(ndli_places *list, ndli_v3 x, ndli_v3 tangent)
{
    if (list->count < list->capacity) {
        list->x[list->count] = x;
        list->tangent[list->count++] = tangent;
    }
}

/* Puts x, and before it as many as are needed on the cubic from the last one. */
static void ndli_nodes_reach(ndli_places *list, ndli_v3 x, ndli_v3 tangent, double longest)
{
    ndli_v3 from = list->x[list->count - 1], start = list->tangent[list->count - 1], way = ndli_sub(x, from);
    double length = ndli_norm(way);
    int pieces = length > longest ? (int)(length / (0.5 * longest)) : 1;
    for (int k = 1; k < pieces && list->count < list->capacity - 1; k++) {
        double s = (double)k / pieces, a = length * s * (1 - s) * (1 - s), b = -length * s * s * (1 - s);
        ndli_v3 place = ndli_madd(from, s * s * (3 - 2 * s), way);
        place = ndli_madd(ndli_madd(place, a, start), b, tangent);
        ndli_nodes_put(list, place, ndli_scale(1 / length, way));
    }
    ndli_nodes_put(list, x, tangent);
}

/* Whether an old node outside is still of use between the last one kept and where the outside ends. */
static int ndli_nodes_keeps(const ndl_needle *needle, const ndli_places *list, int i, ndli_v3 end)
{
    const ndl_rod *rod = needle->rod;
    ndli_v3 t = ndli_nodes_tangent(rod, i);
    double shortest = ndli_nodes_shortest(needle);
    return ndli_dot(ndli_sub(end, rod->x[i]), t) >= shortest &&
           ndli_dot(ndli_sub(rod->x[i], list->x[list->count - 1]), t) >= shortest;
}

/* Sleeve and outside: to `end`, which is the entry or the tip and of the old rod's node `end_index`. */
static void ndli_nodes_outside(const ndl_needle *needle, ndli_places *list, ndli_v3 end, int end_index)
{
    const ndl_rod *rod = needle->rod;
    double longest = ndli_nodes_longest(needle);
    for (int i = 0; i < 2; i++)
        ndli_nodes_put(list, rod->x[i], rod->tangent[0]);
    for (int i = 2; i < end_index; i++)
        if (list->count < list->capacity - 1 && ndli_nodes_keeps(needle, list, i, end))
            ndli_nodes_reach(list, rod->x[i], ndli_nodes_tangent(rod, i), longest);
    ndli_nodes_reach(list, end, ndli_nodes_tangent(rod, end_index), longest);
}

/* How far the tip is beyond the entry; edges are no shorter than a part of the usual. */
static double ndli_nodes_tail(const ndl_needle *needle, ndli_v3 entry)
{
    const ndl_rod *rod = needle->rod;
    return ndli_dot(ndli_sub(rod->x[rod->node_count - 1], entry), rod->tangent[rod->node_count - 2]);
}
static double ndli_nodes_least_tail(const ndl_needle *needle) { return 0.02 * needle->site->mean_edge; }

/* The place on the rod that is nearest to x. */
static ndli_v3 ndli_nodes_on_rod(const ndl_rod *rod, ndli_v3 x)
{
    ndli_v3 best = rod->x[1];
    double least = ndli_norm(ndli_sub(x, best));
    for (int j = 1; j + 1 < rod->node_count; j++) {
        ndli_v3 edge = ndli_sub(rod->x[j + 1], rod->x[j]), place;
        double along = ndli_dot(ndli_sub(x, rod->x[j]), edge) / ndli_dot(edge, edge), far;
        place = ndli_madd(rod->x[j], fmin(fmax(along, 0), 1), edge);
        far = ndli_norm(ndli_sub(x, place));
        if (far < least) {
            least = far;
            best = place;
        }
    }
    return best;
}

/* ---- what belongs to coupled nodes ---- */

/* The old node that a new one is: that of the same tissue node, for a new tip the old tip, else -1. */
static int ndli_nodes_same(const ndl_needle *needle, int old_first, int old_count, int k, int is_tip)
{
    for (int i = 0; i < old_count; i++)
        if (needle->old_path[i] == needle->path[k])
            return old_first + i;
    return is_tip && old_count > 0 ? old_first + old_count - 1 : -1;
}

static int ndli_nodes_nearest(const ndl_needle *needle, int old_first, int old_count, ndli_v3 x)
{
    double nearest = 0;
    int best = -1;
    for (int i = old_first; i < old_first + old_count; i++) {
        ndli_v3 way = ndli_sub(needle->rod->x[i], x);
        double distance = ndli_dot(way, way);
        if (best < 0 || distance < nearest) {
            best = i;
            nearest = distance;
        }
    }
    return best;
}

/* Friction state and contact force of new node first + k. */
static void ndli_nodes_carry(ndl_needle *needle, int old_first, int old_count, int first, int k, int count)
{
    ndli_line *line = &needle->line;
    int same = ndli_nodes_same(needle, old_first, old_count, k, k == count - 1);
    int near = same >= 0 ? same : ndli_nodes_nearest(needle, old_first, old_count, needle->places[first + k]);
    line->state[first + k] = near >= 0 ? needle->old_state[near] : (unsigned char)NDL_STATIC;
    line->contact[first + k] = same >= 0 ? needle->old_contact[same] : ndli_v(0, 0, 0);
}

/* Whether node k of the path, which was its node `old`, is somewhere else in the material since the mesh has followed
 * the tip; new ones are. */
static int ndli_nodes_has_moved(const ndl_needle *needle, int old, int k)
{
    if (!needle->follows)
        return 0;
    return old < 0 || sb_v3_norm(sb_v3_sub(needle->old_X[old], needle->site->mesh->X[needle->path[k]])) > 0;
}

/* From x to a place on the needle; 0 where that is near: there the shaft is drawn to the node. In shares of an edge. */
static const double ndli_nodes_least_gap = 0.01;
static ndli_v3 ndli_nodes_gap_to(const ndl_needle *needle, ndli_v3 x, ndli_v3 place)
{
    ndli_v3 gap = ndli_sub(place, x);
    return ndli_norm(gap) > ndli_nodes_least_gap * needle->site->mean_edge ? gap : ndli_v(0, 0, 0);
}

/* How far node k of the path, which is at x, is from the rod's. An entry that the mesh has where the needle did not
 * come in, or nodes below it that could not be put where the shaft is, do not draw the shaft to them: on curved skin
 * that was up to hundreds of newtons. Later the tip's node comes to the tip. */
static ndli_v3 ndli_nodes_gap(const ndl_needle *needle, int old_first, int old_count, int k, int count, ndli_v3 x,
                              ndli_v3 before)
{
    int is_tip = k > 0 && k == count - 1, same = ndli_nodes_same(needle, old_first, old_count, k, 0);
    if (is_tip && needle->reaches)
        return ndli_v(0, 0, 0);
    if (is_tip && needle->sinks)
        return ndli_nodes_gap_to(needle, x, needle->landing);
    if (k == 0 && needle->enters)
        return ndli_nodes_gap_to(needle, x, ndli_nodes_on_rod(needle->rod, x));
    if (needle->sinks || (!is_tip && ndli_norm(before) > 0 && ndli_nodes_has_moved(needle, same - old_first, k)))
        return ndli_nodes_gap_to(needle, x, ndli_nodes_on_rod(needle->rod, x));
    return same < 0 ? ndli_v(0, 0, 0) : needle->old_gap[same];
}

/* ---- all nodes ---- */

/* 1 when a chain that comes from `before` turns at x by less than 60 degrees on its way to `next`. */
static int ndli_nodes_is_smooth(ndli_v3 before, ndli_v3 x, ndli_v3 next)
{
    ndli_v3 after = ndli_sub(next, x);
    return ndli_dot(before, after) > 0.5 * ndli_norm(before) * ndli_norm(after);
}

/* Writes the nodes of the remesher's path that the rod is on to needle->path; returns how many. Where tissue is
 * crushed, as ahead of a skin that does not break, an edge of the path may lie across the needle: the rod passes over
 * the nodes before it, but never over the tip. ahead: where the needle comes from. */
static int ndli_nodes_thread(ndl_needle *needle, const int *path, int count, ndli_v3 ahead)
{
    const sb_vec3 *x = needle->site->mesh->x;
    int *kept = needle->path, last = -1;
    for (int k = 0; k < count; k++) {
        while (last >= 0) {
            ndli_v3 here = ndli_from(x[kept[last]]);
            ndli_v3 before = last > 0 ? ndli_sub(here, ndli_from(x[kept[last - 1]])) : ahead;
            if (ndli_nodes_is_smooth(before, here, ndli_from(x[path[k]])))
                break;
            last--;
        }
        kept[++last] = path[k];
    }
    return last + 1;
}

NDLI_API int ndli_needle_is_threaded(const ndl_needle *needle)
{
    const ndli_topology *mesh = needle->site->mesh;
    if (needle->site->embeds)
        return 1;
    for (int i = needle->line.first; i <= ndli_line_foremost(&needle->line); i++) {
        ndli_v3 place = ndli_add(ndli_from(mesh->x[needle->path[i - needle->line.first]]), needle->gap[i]);
        ndli_v3 off = ndli_sub(needle->rod->x[i], place);
        if (ndli_dot(off, off) > 0)
            return 0;
    }
    return 1;
}

/* ---- of a needle that is held by rows: nodes in the tissue stay where they are on the rod ---- */

static int ndli_nodes_are(const ndl_rod *rod, const ndli_places *list)
{
    for (int i = 0; i < list->count && list->count == rod->node_count; i++) {
        ndli_v3 gap = ndli_sub(list->x[i], rod->x[i]);
        if (ndli_dot(gap, gap) > 0)
            return 0;
    }
    return list->count == rod->node_count;
}

/* Nodes from `from` on have numbers that are higher by `more`. */
static void ndli_nodes_shift(ndl_needle *needle, int from, int count, int more)
{
    ndli_line *line = &needle->line;
    size_t n = (size_t)count;
    memmove(line->state + from + more, line->state + from, n);
    memmove(line->contact + from + more, line->contact + from, n * sizeof *line->contact);
    memmove(needle->arc + from + more, needle->arc + from, n * sizeof *needle->arc);
    for (int i = 0; i < from + more; i++)
        line->state[i] = NDL_FREE;
}

static int ndli_nodes_renew_rows(ndl_needle *needle)
{
    ndl_rod *rod = needle->rod;
    ndli_line *line = &needle->line;
    int count = line->count, end = count > 0 ? line->first : rod->node_count - 1, first, bad;
    ndli_places list = {needle->places, needle->place_tangents, 0, 0};
    list.capacity = rod->capacity - sbi_max_int(count - 1, 0);
    ndli_nodes_outside(needle, &list, rod->x[end], end);
    first = list.count - 1;
    list.capacity = rod->capacity;
    for (int i = end + 1; i < rod->node_count; i++)
        ndli_nodes_put(&list, rod->x[i], ndli_v(0, 0, 0));
    if (ndli_nodes_are(rod, &list))
        return -1;
    bad = ndli_rod_reparameterise(rod, list.x, list.count);
    if (bad >= 0)
        return bad;
    if (count > 0)
        ndli_nodes_shift(needle, end - 1, count + 1, first - end);
    line->first = count > 0 ? first : rod->node_count;
    return -1;
}

static int ndli_nodes_renew_path(ndl_needle *needle)
{
    ndl_rod *rod = needle->rod;
    ndli_line *line = &needle->line;
    const ndli_topology *mesh = needle->site->mesh;
    int old_first = line->first, old_count = line->count, count, first, bad, shallow;
    const int *path = ndl_remesh_nodes(needle->site->remesh, needle->index, &count);
    int end_index = count > 0 ? sbi_min_int(old_first, rod->node_count - 1) : rod->node_count - 1;
    ndli_places list = {needle->places, needle->place_tangents, 0, 0};
    ndli_v3 end = rod->x[rod->node_count - 1], entry_gap = ndli_v(0, 0, 0);
    if (count > rod->capacity - 4)
        return rod->capacity;
    memcpy(needle->old_path, needle->path, (size_t)old_count * sizeof(int));
    memcpy(needle->old_state, line->state, (size_t)rod->node_count);
    memcpy(needle->old_contact, line->contact, (size_t)rod->node_count * sizeof(ndli_v3));
    memcpy(needle->old_gap, needle->gap, (size_t)rod->node_count * sizeof(ndli_v3));
    shallow = count == 1;
    count = ndli_nodes_thread(needle, path, count, rod->tangent[end_index - 1]);
    path = needle->path;
    if (count > 0) {
        end = ndli_from(mesh->x[path[0]]);
        entry_gap = ndli_nodes_gap(needle, old_first, old_count, 0, count, end, entry_gap);
        end = ndli_add(end, entry_gap);
    }
    list.capacity = rod->capacity - sbi_max_int(count - 1, 0);
    ndli_nodes_outside(needle, &list, end, end_index);
    first = list.count - 1;
    list.capacity = rod->capacity;
    if (count > 0)
        needle->gap[first] = entry_gap;
    for (int k = 1; k < count; k++) {
        ndli_v3 x = ndli_from(mesh->x[path[k]]);
        needle->gap[first + k] = ndli_nodes_gap(needle, old_first, old_count, k, count, x, needle->gap[first + k - 1]);
        ndli_nodes_put(&list, ndli_add(x, needle->gap[first + k]), ndli_v(0, 0, 0));
    }
    needle->enters = needle->sinks = needle->reaches = needle->follows = 0;
    if (shallow && ndli_nodes_tail(needle, end) > ndli_nodes_least_tail(needle))
        ndli_nodes_put(&list, rod->x[rod->node_count - 1], ndli_v(0, 0, 0));
    for (int k = 0; k < count; k++)
        ndli_nodes_carry(needle, old_first, old_count, first, k, count);
    bad = ndli_rod_reparameterise(rod, list.x, list.count);
    if (bad >= 0)
        return bad;
    for (int i = 0; i < rod->node_count; i++)
        if (count == 0 || i < first || i >= first + count)
            line->state[i] = NDL_FREE;
    line->first = count > 0 ? first : rod->node_count;
    line->count = count;
    needle->shallow = shallow;
    return -1;
}

NDLI_API int ndli_needle_renew_nodes(ndl_needle *needle)
{
    return needle->site->embeds ? ndli_nodes_renew_rows(needle) : ndli_nodes_renew_path(needle);
}

/* ==== src/needle/needle_undo.c ==== */
/* needle_undo: the state of a body, its remesher and its needles at the start of a step, or of one of its substeps. */


#include <string.h>

/* Parts begin where doubles may. */
static size_t ndli_undo_aligned(size_t bytes) { return (bytes + 15) / 16 * 16; }

/* What a needle has beside its rod: its fields, and the arrays that go from step to step. */
static size_t ndli_undo_needle_size(const ndl_needle *needle, int node_count, int point_count)
{
    size_t n = (size_t)node_count, points = (size_t)point_count;
    return ndli_undo_aligned(sizeof *needle) + 2 * ndli_undo_aligned(n * sizeof(ndli_v3)) +
           ndli_undo_aligned(n * sizeof(int)) + ndli_undo_aligned(n) + ndli_undo_aligned(n * sizeof(double)) +
           ndli_undo_aligned(points * sizeof(ndli_v3)) + ndli_undo_aligned(points * sizeof(double)) +
           ndli_undo_aligned(points * sizeof(int)) + ndli_undo_aligned(ndli_rod_snapshot_size(needle->rod, node_count));
}

/* What contact keeps of tools. */
static size_t ndli_undo_touch_size(const struct ndli_site *site)
{
    const sbi_touch *touch = sbi_body_get_touch(site->body);
    return touch ? ndli_undo_aligned(touch->kept_size(touch->user)) : 0;
}

static size_t ndli_undo_remesh_size(const struct ndli_site *site)
{
    return site->embeds ? 0 : ndli_remesh_snapshot_size(site->remesh);
}

/* body: bytes of the body's part. */
static size_t ndli_undo_size(const struct ndli_site *site, size_t body)
{
    size_t sum = ndli_undo_aligned(body) + ndli_undo_touch_size(site) + ndli_undo_aligned(ndli_undo_remesh_size(site));
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (site->needles[i])
            sum += ndli_undo_needle_size(site->needles[i], site->needles[i]->rod->node_count,
                                         site->needles[i]->track.count);
    return sum;
}

static int ndli_undo_make_room(struct ndli_site *site, ndli_kept *kept, size_t needed)
{
    unsigned char *grown;
    if (needed <= kept->room)
        return 1;
    grown = (unsigned char *)sbi_alloc(&site->allocator, needed, 1);
    if (!grown)
        return 0;
    sbi_free(&site->allocator, kept->bytes);
    kept->bytes = grown;
    kept->room = needed;
    memset(&kept->held, 0, sizeof kept->held);
    return 1;
}

static int ndli_undo_make_all_room(struct ndli_site *site, size_t needed)
{
    for (int i = 0; i < NDLI_KEPT_COUNT; i++)
        if (!ndli_undo_make_room(site, site->kept + i, needed))
            return 0;
    return 1;
}

NDLI_API int ndli_needle_reserve_undo(struct ndli_site *site, const ndl_needle *more)
{
    size_t sum = ndli_undo_aligned(sbi_body_snapshot_size(site->body) / 4 * 5) + ndli_undo_touch_size(site) +
                 ndli_undo_aligned(site->embeds ? 0 : ndli_remesh_snapshot_room(site->remesh));
    sum += more ? ndli_undo_needle_size(more, more->rod->capacity, more->track.capacity) : 0;
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (site->needles[i])
            sum += ndli_undo_needle_size(site->needles[i], site->needles[i]->rod->capacity,
                                         site->needles[i]->track.capacity);
    return ndli_undo_make_all_room(site, sum);
}

/* Copies `bytes` of a part to the block, or back from it, and goes on to the next part. */
static void ndli_undo_copy(unsigned char **at, void *part, size_t bytes, int back)
{
    if (bytes)
        memcpy(back ? part : (void *)*at, back ? (const void *)*at : part, bytes);
    *at += ndli_undo_aligned(bytes);
}

static void ndli_undo_copy_needle(ndl_needle *needle, int node_count, unsigned char **at, int back)
{
    size_t n = (size_t)node_count, points;
    ndli_undo_copy(at, needle, sizeof *needle, back);
    points = (size_t)needle->track.count;
    ndli_undo_copy(at, needle->line.contact, n * sizeof(ndli_v3), back);
    ndli_undo_copy(at, needle->gap, n * sizeof(ndli_v3), back);
    ndli_undo_copy(at, needle->path, n * sizeof(int), back);
    ndli_undo_copy(at, needle->line.state, n, back);
    ndli_undo_copy(at, needle->arc, needle->arc ? n * sizeof(double) : 0, back);
    ndli_undo_copy(at, needle->track.X, points * sizeof(ndli_v3), back);
    ndli_undo_copy(at, needle->track.arc, points * sizeof(double), back);
    ndli_undo_copy(at, needle->track.elements, points * sizeof(int), back);
}

NDLI_API int ndli_needle_keep(struct ndli_site *site, ndli_keeping which)
{
    ndli_kept *kept = site->kept + which;
    const sbi_touch *touch = sbi_body_get_touch(site->body);
    size_t body = sbi_body_snapshot_size(site->body), needed = ndli_undo_size(site, body);
    unsigned char *at;
    if (needed > kept->room && !ndli_undo_make_all_room(site, needed + needed / 8))
        return 0;
    kept->body = body;
    at = kept->bytes;
    sbi_body_snapshot(site->body, at, &kept->held);
    at += ndli_undo_aligned(body);
    if (touch && !touch->keep(touch->user, at))
        return 0;
    at += ndli_undo_touch_size(site);
    if (!site->embeds)
        ndli_remesh_snapshot(site->remesh, at);
    at += ndli_undo_aligned(ndli_undo_remesh_size(site));
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (site->needles[i]) {
            ndl_rod *rod = site->needles[i]->rod;
            ndli_rod_snapshot(rod, at);
            at += ndli_undo_aligned(ndli_rod_snapshot_size(rod, rod->node_count));
            ndli_undo_copy_needle(site->needles[i], rod->node_count, &at, 0);
        }
    return 1;
}

/* The body with what touches it; 0: no memory. */
static int ndli_undo_rewind_body(struct ndli_site *site, const ndli_kept *kept)
{
    const sbi_touch *touch = sbi_body_get_touch(site->body);
    sb_result result;
    if (!site->embeds)
        ndli_remesh_set_own(site->remesh, 1);
    result = sbi_body_rewind(site->body, kept->bytes, kept->body, NULL);
    if (!site->embeds)
        ndli_remesh_set_own(site->remesh, 0);
    return result == SB_OK && (!touch || touch->rewind(touch->user, kept->bytes + ndli_undo_aligned(kept->body)));
}

NDLI_API sb_result ndli_needle_undo(struct ndli_site *site, ndli_keeping which, sb_error *error)
{
    const ndli_kept *kept = site->kept + which;
    unsigned char *at = kept->bytes + ndli_undo_aligned(kept->body) + ndli_undo_touch_size(site);
    site->undo_waits = !ndli_undo_rewind_body(site, kept);
    if (site->undo_waits)
        return sbi_fail(error, SB_ERROR_MEMORY,
                        "no memory to take the failed step back: that comes first in the next step");
    if (!site->embeds)
        ndli_remesh_rewind(site->remesh, at);
    at += ndli_undo_aligned(ndli_undo_remesh_size(site));
    for (int i = 0; i < NDL_MAX_NEEDLES; i++)
        if (site->needles[i]) {
            ndl_rod *rod = site->needles[i]->rod;
            ndli_rod_rewind(rod, at);
            at += ndli_undo_aligned(ndli_rod_snapshot_size(rod, rod->node_count));
            ndli_undo_copy_needle(site->needles[i], rod->node_count, &at, 1);
        }
    return SB_OK;
}

NDLI_API sb_result ndli_needle_finish_undo(struct ndli_site *site, sb_error *error)
{
    sb_result result;
    if (!site->undo_waits)
        return SB_OK;
    result = ndli_needle_undo(site, NDLI_KEPT_STEP, error);
    for (int i = 0; i < NDL_MAX_NEEDLES && result == SB_OK; i++)
        if (site->needles[i])
            ndli_rod_publish(site->needles[i]->rod);
    return result;
}

NDLI_API sb_result ndli_needle_look(struct ndli_site *site, sb_error *error)
{
    int stale = ndli_site_is_stale(site);
    sb_result result = ndli_site_look(site, error);
    if (result == SB_OK && !ndli_site_reserve_places(site)) /* a cut may have made the body larger */
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the nodes of a body that has grown");
    for (int i = 0; i < NDL_MAX_NEEDLES && stale && result == SB_OK; i++)
        if (site->needles[i]) {
            if (site->needles[i]->line.count > 0)
                site->needles[i]->lost = NDLI_LOST_MESH;
            ndli_held_leave(site->needles[i]);
            site->needles[i]->shallow = 0;
        }
    return result;
}

/* ==== src/needle/needle_step.c ==== */
/* needle_step: one step of a body and its needles. Sleeves are moved and fed, one linear system gives the motion of
 * all, the remesher follows the tips, and the rods' nodes follow the remesher. */


#include <string.h>

static double ndli_step_now(const struct ndli_site *site) { return sbi_body_now(site->body); }

/* ---- a substep ---- */

typedef struct ndli_stepping {
    struct ndli_site *site;
    ndl_needle *const *needles;
    const ndl_command *commands;
    int count;
    ndli_line *lines[NDL_MAX_NEEDLES];
    int patience; /* see sbi_step_part */
    int unmoved;  /* the needle whose rod found no motion in the substep last tried, or -1 */
    ndl_step_info *info;
    sb_error *error;
} ndli_stepping;

/* Which part of the step a substep is. */
typedef struct ndli_part {
    sb_real begin, end; /* of the step, as shares of it */
    double left;        /* its share of what is left of the step */
} ndli_part;

static void ndli_step_note_solve(ndl_step_info *info, const ndl_couple_info *couple)
{
    info->trials = sbi_max_int(info->trials, couple->trials);
    info->consistent = info->consistent && couple->consistent;
    info->iterations += info->body.pcg_iterations;
    info->capped = info->capped || info->body.capped;
    info->residual = sb_max(info->residual, info->body.residual);
}

static int ndli_step_max_trials(const ndli_stepping *s)
{
    int most = 1;
    for (int k = 0; k < s->count; k++)
        most = sbi_max_int(most, s->needles[k]->max_trials);
    return most;
}

/* What the sleeve has to exert: the balance of the nodes in it, and the frame's torque. */
static void ndli_step_read_base(ndl_needle *needle)
{
    ndl_rod *rod = needle->rod;
    const ndli_v3 *r = needle->line.reaction;
    ndli_v3 arm = ndli_sub(rod->x[0], rod->x[1]);
    needle->base_force = ndli_add(r[0], r[1]);
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    ndli_rod_derivatives(rod, 0, rod->gradient, rod->turn_gradient, NULL);
    needle->base_torque = ndli_madd(ndli_cross(arm, r[0]), rod->turn_gradient[0], rod->tangent[0]);
}

/* A tip that goes back stays ahead of the node before it; in a step it gets no further than where its last edge began.
 * edge: the one before the motion. */
static void ndli_step_keep_tip_ahead(ndl_needle *needle, ndli_v3 edge)
{
    ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1;
    ndli_v3 now = ndli_sub(rod->x[last], rod->x[last - 1]);
    if (needle->line.slip[ndli_line_foremost(&needle->line)] < 0 && ndli_dot(now, edge) < 0.1 * ndli_dot(edge, edge))
        rod->x[last] = ndli_madd(rod->x[last - 1], 0.1, edge);
}

/* Largest strain of an edge. */
static double ndli_step_strain(const ndl_rod *rod)
{
    double most = 0;
    for (int j = 0; j + 1 < rod->node_count; j++)
        most = fmax(most, fabs(ndli_norm(ndli_sub(rod->x[j + 1], rod->x[j])) / rod->rest_length[j] - 1));
    return most;
}

/* Linear equations stretch edges that they turn far; needles break at such strains. */
static const double ndli_step_most_strain = 0.01;

/* As the linear system has found it. Returns -1, or the node at which the rod would fold. */
static int ndli_step_move_linear(ndl_needle *needle, double dt)
{
    ndl_rod *rod = needle->rod;
    const ndli_v3 *move = needle->line.move;
    ndli_v3 edge = ndli_sub(rod->x[rod->node_count - 1], rod->x[rod->node_count - 2]);
    for (int i = 0; i < rod->node_count; i++) {
        rod->x[i] = rod->held[i] ? rod->target[i] : ndli_add(rod->x[i], move[i]);
        rod->v[i] = ndli_scale(1 / dt, move[i]);
        rod->a[i] = ndli_v(0, 0, 0);
    }
    ndli_step_keep_tip_ahead(needle, edge);
    return ndli_rod_moved(rod);
}

/* Newton's method for the nodes outside, those in the tissue where the linear system has them; from the state before.
 * 0: not found. */
static int ndli_step_move_nonlinear(ndl_needle *needle, double dt)
{
    ndl_rod *rod = needle->rod;
    const ndli_line *line = &needle->line;
    int done;
    for (int i = ndli_line_rearmost(line); i <= ndli_line_foremost(line); i++) {
        rod->held[i] = 1;
        rod->has_velocity[i] = 0;
        rod->target[i] = ndli_add(rod->x[i], line->move[i]);
    }
    done = ndli_rod_step_euler(rod, dt);
    for (int i = ndli_line_rearmost(line); i <= ndli_line_foremost(line); i++)
        rod->held[i] = i < 2;
    for (int i = 0; i < 2 && done; i++)
        line->reaction[i] = rod->reaction[i];
    return done;
}

static sb_result ndli_step_move_rod(ndl_needle *needle, double dt, sb_error *error)
{
    ndl_rod *rod = needle->rod;
    double before = ndli_step_strain(rod);
    int linear = needle->line.count > 0; /* alone, a rod needs no linear system */
    if (linear) {
        ndli_rod_save(rod);
        linear = ndli_step_move_linear(needle, dt) < 0 && ndli_step_strain(rod) <= before + ndli_step_most_strain;
        if (!linear)
            ndli_rod_restore(rod);
    }
    if (!linear && (needle->line.count > 0 || !ndli_step_move_nonlinear(needle, dt)))
        return sbi_fail(error, SB_ERROR_DIVERGED, "needle %d: no motion of the rod was found", needle->index);
    ndli_step_read_base(needle);
    return SB_OK;
}

/* The rod's nodes on those of the path. */
static sb_result ndli_step_renew(ndl_needle *needle, sb_error *error)
{
    int bad = ndli_needle_renew_nodes(needle);
    if (bad < 0)
        return SB_OK;
    if (bad >= needle->rod->capacity)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "needle %d: its capacity of %d nodes is too little for what is in the tissue", needle->index,
                        needle->rod->capacity);
    return sbi_fail_node(error, SB_ERROR_DIVERGED, bad, "needle %d would fold at its node %d", needle->index, bad);
}

static sb_result ndli_step_follow(const ndli_stepping *s, ndl_needle *needle)
{
    ndl_remesh_info done;
    sb_result result;
    double begin = ndli_step_now(s->site), middle;
    memset(&done, 0, sizeof done);
    done.worst_quality = 1;
    if (s->site->embeds)
        ndli_held_follow_tip(needle), result = SB_OK;
    else
        result = ndli_needle_follow_tip(needle, &done, s->error);
    middle = ndli_step_now(s->site);
    s->info->seconds_remesh += middle - begin;
    s->info->operations += done.substeps;
    s->info->worst_quality = sb_min(s->info->worst_quality, done.worst_quality);
    if (result != SB_OK)
        return result;
    result = ndli_step_renew(needle, s->error);
    s->info->seconds_needle += ndli_step_now(s->site) - middle;
    return result;
}

static sb_result ndli_step_prepare(const ndli_stepping *s, double dt, double share)
{
    static const ndl_command none = {0, 0, {0, 0, 0}, {0, 0, 0}};
    double begin = ndli_step_now(s->site);
    ndli_held_forget(s->site);
    for (int k = 0; k < s->count; k++) {
        ndl_needle *needle = s->needles[k];
        sb_result result = ndli_needle_is_threaded(needle) ? SB_OK : ndli_step_renew(needle, s->error);
        if (result != SB_OK)
            return result;
        ndli_bevel_begin(needle);
        ndli_needle_aim(needle, s->commands ? s->commands + k : &none, dt, share);
        if (s->site->embeds)
            ndli_held_resist(needle);
        else
            ndli_needle_resist(needle);
        needle->hold_steps = sbi_max_int(0, needle->hold_steps - 1);
    }
    s->info->seconds_needle += ndli_step_now(s->site) - begin;
    return SB_OK;
}

/* One step of the body with the rods as its guest; then the rods move as was found. What has moved when that fails the
 * whole step's undo takes back. */
static sb_result ndli_step_solve(ndli_stepping *s, double dt, const ndli_part *part)
{
    struct ndli_site *site = s->site;
    double begin = ndli_step_now(site), solve;
    const sbi_guest *guests[1];
    sbi_step_part span;
    ndli_couple couple;
    sb_result result;
    if (site->embeds)
        ndli_couple_prepare_rows(&couple, s->lines, s->count, ndli_step_max_trials(s), site->unknown, site->coupled,
                                 site->coupled_count);
    else
        ndli_couple_prepare(&couple, s->lines, s->count, ndli_step_max_trials(s), site->unknown, site->coupled);
    guests[0] = &couple.guest;
    span.begin = part->begin, span.end = part->end;
    span.patience = s->patience;
    result = sbi_body_step_part(site->body, (sb_real)dt, guests, 1, &span, &s->info->body);
    solve = s->info->body.seconds_solve;
    s->info->seconds_couple += solve;
    s->info->seconds_body += ndli_step_now(site) - begin - solve;
    begin = ndli_step_now(site);
    if (result == SB_OK)
        result = ndli_couple_check(&couple, &s->info->body.error);
    for (int k = 0; k < s->count && result == SB_OK; k++) {
        result = ndli_step_move_rod(s->needles[k], dt, &s->info->body.error);
        s->unmoved = result == SB_OK ? -1 : k;
    }
    s->info->seconds_needle += ndli_step_now(site) - begin;
    if (result == SB_OK)
        ndli_step_note_solve(s->info, &couple.info);
    else if (s->error)
        *s->error = s->info->body.error;
    return result;
}

/* A substep of dt up to where the rods have moved. */
static sb_result ndli_step_advance(ndli_stepping *s, double dt, const ndli_part *part)
{
    sb_result result = ndli_step_prepare(s, dt, part->left);
    s->unmoved = -1;
    if (result == SB_OK)
        result = ndli_step_solve(s, dt, part);
    if (result == SB_OK)
        result = ndli_site_look(s->site, s->error);
    return result;
}

/* The rest of it: tips are followed. */
static sb_result ndli_step_end_substep(const ndli_stepping *s)
{
    sb_result result = SB_OK;
    for (int k = 0; k < s->count && result == SB_OK; k++)
        result = ndli_step_follow(s, s->needles[k]);
    for (int k = 0; k < s->count && result == SB_OK; k++)
        s->info->peak_base = sb_max(s->info->peak_base, (sb_real)ndli_norm(s->needles[k]->base_force));
    s->info->substeps++;
    return result;
}

/* ---- membranes within a step, and substeps that fail ---- */

/* Times the body's cap on iterations; and tries of a step that may fail before it does. */
enum { NDLI_STEP_PATIENCE = 8, NDLI_STEP_FAILURES = 24 };

/* Substeps get no shorter than that share of one: their rounding would be felt. */
static const double ndli_step_shortest = 1e-3;

/* Share of a substep of dt in which the first tip comes to where a membrane begins or ends; 1: none does. */
static double ndli_step_share_to_edge(const ndli_stepping *s, double dt)
{
    double least = 1;
    for (int k = 0; k < s->count; k++)
        least = fmin(least, ndli_needle_share_to_edge(s->needles[k], dt));
    return least < 1 - ndli_step_shortest ? fmax(least, ndli_step_shortest) : 1;
}

/* Substeps of a step, in units of the first guess of them, which are all 1 long. One that is too long for linear
 * equations, which fold a rod, or for the tissue is taken again a fourth as long; what follows it grows again. */
enum { NDLI_STEP_EDGES = 12, NDLI_FINEST = 64 };
typedef struct ndli_step_ends {
    double edge;  /* where the first tip comes to an edge of a membrane, as the last try has shown */
    double reach; /* times as far as a first try shows it: a tip that sticks before it jumps comes there later */
    int edge_count, substeps;
    int finer;     /* substeps end at multiples of 1/finer: a power of 4 up to NDLI_FINEST */
    int last_hope; /* 1: the shortest one failed; it is tried as a whole once more, and waited for */
    int failures;  /* of all substeps */
} ndli_step_ends;

static double ndli_step_end_after(const ndli_step_ends *ends, double t)
{
    double finer = ends->finer, next = (floor(t * finer) + 1) / finer;
    return ends->edge > t ? fmin(next, ends->edge) : next;
}

static ndli_part ndli_step_part(const ndli_step_ends *ends, double t, double end)
{
    ndli_part part;
    part.begin = (sb_real)(t / ends->substeps);
    part.end = (sb_real)(end / ends->substeps);
    part.left = (end - t) / (ends->substeps - t);
    return part;
}

static int ndli_step_looks_for_edges(const ndli_step_ends *ends, double t, double end)
{
    return ends->edge_count < NDLI_STEP_EDGES && end - t > 2 * ndli_step_shortest;
}

/* What a substep is taken back to: before the first the mesh is still that of the step's start. */
static sb_result ndli_step_keep_substep(const ndli_stepping *s, double t, ndli_keeping *kept)
{
    *kept = t > 0 ? NDLI_KEPT_SUBSTEP : NDLI_KEPT_STEP;
    if (*kept == NDLI_KEPT_SUBSTEP && !ndli_needle_keep(s->site, *kept))
        return sbi_fail(s->error, SB_ERROR_MEMORY, "no memory to keep the state at the start of a substep");
    return SB_OK;
}

/* What is told of a try that is taken back: as before, but for what it took. */
static void ndli_step_forget(ndl_step_info *info, const ndl_step_info *before)
{
    ndl_step_info taken = *info;
    *info = *before;
    info->iterations = taken.iterations;
    info->seconds_body = taken.seconds_body;
    info->seconds_couple = taken.seconds_couple;
    info->seconds_needle = taken.seconds_needle;
    info->seconds_remesh = taken.seconds_remesh;
}

/* 1: shorter steps may do better. */
static int ndli_step_may_be_too_long(sb_result result)
{
    return result == SB_ERROR_DIVERGED || result == SB_ERROR_INVERTED || result == SB_ERROR_INDEFINITE ||
           result == SB_ERROR_NOT_CONVERGED;
}

/* A substep failed: shorter ones. Tissue that does not let needles go their way is waited for in the shortest, and if
 * that does not help in the whole one: in long ones more iterations would but crush it. 0: nothing is left to be
 * tried. */
static int ndli_step_shorten(ndli_step_ends *ends)
{
    if (++ends->failures > NDLI_STEP_FAILURES || ends->last_hope)
        return 0;
    ends->last_hope = ends->finer == NDLI_FINEST;
    ends->finer = ends->last_hope ? 1 : 4 * ends->finer;
    return 1;
}

/* A substep to t is done: those that follow are four times as long where that is a place for them to begin. */
static void ndli_step_lengthen(ndli_step_ends *ends, double t)
{
    double longer = t * ends->finer / 4;
    if (ends->finer > 1 && longer == floor(longer))
        ends->finer /= 4;
    ends->last_hope = 0;
}

static int ndli_step_patience(const ndli_step_ends *ends)
{
    return ends->finer == NDLI_FINEST || ends->last_hope ? NDLI_STEP_PATIENCE : 1;
}

/* A substep from t on, to the first edge of a membrane that a tip runs through in it: what it has to cut is one force
 * in a substep. No mesh has followed a tip where one is taken back for that. *end: where it ends. */
static sb_result ndli_step_try_substep(ndli_stepping *s, double dt, ndli_step_ends *ends, double t, ndli_keeping kept,
                                       double *end)
{
    ndl_step_info before = *s->info;
    double reach = ends->reach;
    sb_result result = SB_OK;
    s->patience = ndli_step_patience(ends);
    while (result == SB_OK) {
        double length, share = 1;
        ndli_part part;
        *end = ndli_step_end_after(ends, t);
        length = (*end - t) * (dt / ends->substeps);
        part = ndli_step_part(ends, t, *end);
        result = ndli_step_advance(s, length, &part);
        if (result == SB_OK && ndli_step_looks_for_edges(ends, t, *end))
            share = ndli_step_share_to_edge(s, length);
        if (result != SB_OK || !(share < 1))
            break;
        ends->edge = t + fmin(share * reach, 0.5 * (1 + share)) * (*end - t);
        reach = 1;
        ends->edge_count++;
        ndli_step_forget(s->info, &before);
        result = ndli_needle_undo(s->site, kept, s->error);
    }
    ends->reach *= *end >= ends->edge && ends->edge > t ? 2 : 1;
    return result == SB_OK ? ndli_step_end_substep(s) : result;
}

/* The next substep, as long as it can be. */
static sb_result ndli_step_run_substep(ndli_stepping *s, double dt, ndli_step_ends *ends, double t, double *end)
{
    ndl_step_info before = *s->info;
    ndli_keeping kept;
    sb_result result = ndli_step_keep_substep(s, t, &kept);
    if (result == SB_OK)
        result = ndli_step_try_substep(s, dt, ends, t, kept, end);
    while (ndli_step_may_be_too_long(result) && ndli_step_shorten(ends)) {
        ndli_step_forget(s->info, &before);
        result = ndli_needle_undo(s->site, kept, s->error);
        if (result == SB_OK)
            result = ndli_step_try_substep(s, dt, ends, t, kept, end);
    }
    if (result == SB_OK)
        ndli_step_lengthen(ends, *end);
    return result;
}

/* ---- a step ---- */

static const double ndli_step_most_substeps = 1000;

/* How far a command takes a needle in the length of half an edge, and in half a radian. What is drawn in comes off the
 * edge at the sleeve, which may be no longer than that, and needs some left: it counts twice. */
static double ndli_step_stride(const ndl_needle *needle, const ndl_command *command, double dt)
{
    const ndl_rod *rod = needle->rod;
    double edge = needle->site->mean_edge, unit = 0.5 * (edge < needle->edge_length ? edge : needle->edge_length);
    double out = ndli_norm(ndli_sub(rod->x[sbi_min_int(needle->line.first, rod->node_count - 1)], needle->outlet));
    double way = 0, turn = 0;
    if (command) {
        double spin = ndli_norm(ndli_from(command->angular_velocity));
        double fed = (double)command->insertion;
        way = dt * (fmax(fed, -2 * fed) + ndli_norm(ndli_from(command->velocity)) + out * spin);
        turn = dt * (fabs((double)command->twist) + spin);
    }
    if (needle->base_given) {
        way += ndli_norm(ndli_sub(needle->given_outlet, needle->outlet)) +
               out * ndli_norm(ndli_sub(needle->given_axis, needle->axis));
        turn += ndli_norm(ndli_sub(needle->given_axis, needle->axis)) +
                fabs(ndli_needle_given_turn(needle, needle->given_axis));
    }
    return way / unit > turn / 0.5 ? way / unit : turn / 0.5;
}

static int ndli_step_is_command_finite(const ndl_command *c)
{
    return sb_is_finite(c->insertion) && sb_is_finite(c->twist) && sb_v3_is_finite(c->velocity) &&
           sb_v3_is_finite(c->angular_velocity);
}

static sb_result ndli_step_check(const struct ndli_site *site, ndl_needle *const *needles, int count, sb_real dt,
                                 const ndl_command *commands, int *substeps, sb_error *error)
{
    double most = 0;
    if (!needles || !(dt > 0) || !sb_is_finite(dt))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a step needs a body, its needles and dt > 0, not %g", (double)dt);
    if (!site || count != site->count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d needles given, the body has %d", count, site ? site->count : 0);
    if (!site->embeds && sbi_body_has_pieces(site->body))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "the body is cut: needles cannot go through pieces of elements yet; destroy them, and go on "
                        "with sb_body_step");
    for (int k = 0; k < count; k++) {
        double stride;
        if (!needles[k] || needles[k]->site != site)
            return sbi_fail(error, SB_ERROR_ARGUMENT, "needle %d is not of this body", k);
        for (int i = 0; i < k; i++)
            if (needles[i] == needles[k])
                return sbi_fail(error, SB_ERROR_ARGUMENT, "needles %d and %d are the same", i, k);
        if (commands && !ndli_step_is_command_finite(commands + k))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "command %d is not finite", k);
        stride = ndli_step_stride(needles[k], commands ? commands + k : NULL, (double)dt);
        most = stride > most ? stride : most;
    }
    if (!(most < ndli_step_most_substeps))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the commands would take %g substeps: too fast for a step of %g s",
                        most, (double)dt);
    *substeps = most > 1 ? (int)most + 1 : 1;
    return SB_OK;
}

static void ndli_step_count_states(const ndli_stepping *s)
{
    for (int k = 0; k < s->count; k++) {
        const ndl_needle *needle = s->needles[k];
        for (int i = ndli_line_rearmost(&needle->line); i <= ndli_line_foremost(&needle->line); i++) {
            s->info->dynamic_nodes += ndli_line_is_slipping(&needle->line, i);
            s->info->static_nodes += !ndli_line_is_slipping(&needle->line, i);
        }
        s->info->blocked += needle->blocked;
        s->info->limited += needle->limited;
        s->info->coarse += ndli_bevel_is_coarse(needle);
    }
}

static int ndli_step_let_go(ndl_needle *needle)
{
    struct ndli_site *site = needle->site;
    if (!site->embeds)
        return ndl_remesh_withdraw(site->remesh, needle->index, NULL, NULL) == SB_OK;
    ndli_held_leave(needle);
    needle->lost = NDLI_LOST_TORN;
    return 1;
}

/* One that is hardly in tears out of the skin. One whose mesh follows may have been left so far beside its path that no
 * step, however short, brings it there: from then on it would be stuck, also where it is drawn back. */
static int ndli_step_may_tear(const ndli_stepping *s, int k)
{
    const ndl_needle *needle = s->needles[k];
    if (needle->line.count == 0)
        return 0;
    return (double)ndl_needle_depth(needle) < 0.5 * s->site->mean_edge || (k == s->unmoved && !s->site->embeds);
}

/* Takes needles out when no step can be made with them. Returns how many; 0: nothing has changed; -1: no memory to take
 * back what has. */
static int ndli_step_tear_out(const ndli_stepping *s)
{
    int torn = 0;
    for (int k = 0; k < s->count; k++) {
        ndl_needle *needle = s->needles[k];
        if (!ndli_step_may_tear(s, k))
            continue;
        if (!ndli_step_let_go(needle) || ndli_needle_renew_nodes(needle) >= 0)
            return ndli_needle_undo(s->site, NDLI_KEPT_STEP, s->error) == SB_OK ? 0 : -1;
        torn++;
    }
    return torn;
}

/* In so many substeps, one more wherever a tip runs through an edge of a membrane, and more where one fails. */
static sb_result ndli_step_run(ndli_stepping *s, double dt, int substeps)
{
    ndli_step_ends ends;
    sb_result result = SB_OK;
    memset(&ends, 0, sizeof ends);
    ends.substeps = substeps;
    ends.finer = 1;
    ends.reach = 1;
    memset(s->info, 0, sizeof *s->info);
    s->info->consistent = 1;
    s->info->worst_quality = 1;
    for (double t = 0, end = 0; t < substeps && result == SB_OK; t = end)
        result = ndli_step_run_substep(s, dt, &ends, t, &end);
    if (result != SB_OK && ndli_needle_undo(s->site, NDLI_KEPT_STEP, s->error) != SB_OK)
        return SB_ERROR_MEMORY;
    return result;
}

/* A step that is sound in its arguments. */
static sb_result ndli_step_make(ndli_stepping *s, double dt, int substeps)
{
    double begin = ndli_step_now(s->site);
    sb_result result;
    for (int k = 0; k < s->count; k++) {
        s->lines[k] = &s->needles[k]->line;
        s->needles[k]->blocked = s->needles[k]->limited = 0;
    }
    result = ndli_needle_look(s->site, s->error);
    if (result != SB_OK)
        return result;
    if (!ndli_needle_keep(s->site, NDLI_KEPT_STEP))
        return sbi_fail(s->error, SB_ERROR_MEMORY, "no memory to keep the state at the start of a step");
    result = ndli_step_run(s, dt, substeps);
    if (result == SB_ERROR_DIVERGED) {
        int torn = ndli_step_tear_out(s);
        if (torn != 0)
            result = torn > 0 ? ndli_step_run(s, dt, substeps) : SB_ERROR_MEMORY;
        s->info->torn = result == SB_OK ? torn : 0;
    }
    for (int k = 0; k < s->count; k++) {
        s->needles[k]->base_given = s->needles[k]->base_given && result != SB_OK;
        ndli_rod_publish(s->needles[k]->rod);
    }
    ndli_step_count_states(s);
    s->info->seconds_total = ndli_step_now(s->site) - begin;
    return result;
}

NDL_API sb_result ndl_step(sb_body *body, ndl_needle *const *needles, int count, sb_real dt,
                           const ndl_command *commands, ndl_step_info *info, sb_error *error)
{
    ndl_step_info own;
    ndli_stepping s;
    sb_result result;
    int substeps = 1;
    s.info = info ? info : &own;
    memset(s.info, 0, sizeof *s.info);
    s.site = body ? ndli_needle_site(body) : NULL;
    result = s.site ? ndli_needle_finish_undo(s.site, error) : SB_OK; /* before needles are looked at */
    if (result == SB_OK)
        result = ndli_step_check(s.site, needles, count, dt, commands, &substeps, error);
    if (result != SB_OK)
        return result;
    s.unmoved = -1;
    s.needles = needles;
    s.commands = commands;
    s.count = count;
    s.error = error;
    sbi_body_mute(body);
    result = ndli_step_make(&s, (double)dt, substeps);
    sbi_body_unmute(body);
    ndli_needle_tell_step(s.site, needles, count, dt, commands, result);
    return result;
}

/* ---- a step of a recording ---- */

static sb_result ndli_replay_step(struct ndli_site *site, const int *ints, size_t int_count, const sb_real *reals,
                                  size_t real_count, sb_error *error)
{
    ndl_needle *needles[NDL_MAX_NEEDLES];
    ndl_command commands[NDL_MAX_NEEDLES];
    int count = ints[1];
    if (count < 0 || count > NDL_MAX_NEEDLES || int_count != 2 + (size_t)count ||
        real_count != 1 + NDLI_COMMAND_REALS * (size_t)count)
        return sbi_fail(error, SB_ERROR_FORMAT, "the recording holds a step of %d needles that is none", count);
    for (int k = 0; k < count; k++) {
        const sb_real *c = reals + 1 + NDLI_COMMAND_REALS * k;
        if (ints[2 + k] < 0 || ints[2 + k] >= NDL_MAX_NEEDLES)
            return sbi_fail(error, SB_ERROR_FORMAT, "the recording holds a step of needle %d", ints[2 + k]);
        needles[k] = site->needles[ints[2 + k]];
        commands[k].insertion = c[0], commands[k].twist = c[1];
        commands[k].velocity = sb_v3(c[2], c[3], c[4]);
        commands[k].angular_velocity = sb_v3(c[5], c[6], c[7]);
    }
    return ndl_step(site->body, needles, count, reals[0], commands, NULL, error);
}

NDLI_API sb_result ndli_needle_replay(void *user, const int *ints, size_t int_count, const sb_real *reals,
                                      size_t real_count, sb_error *error)
{
    struct ndli_site *site = (struct ndli_site *)user;
    int code = int_count >= 2 ? ints[0] : 0;
    if (code == NDLI_COMMAND_STEP)
        return ndli_replay_step(site, ints, int_count, reals, real_count, error);
    if (code == NDLI_COMMAND_BASE && real_count == 9 && ints[1] >= 0 && ints[1] < NDL_MAX_NEEDLES &&
        site->needles[ints[1]])
        return ndl_needle_move_base(site->needles[ints[1]], sb_v3(reals[0], reals[1], reals[2]),
                                    sb_v3(reals[3], reals[4], reals[5]), sb_v3(reals[6], reals[7], reals[8]));
    if (code == NDLI_COMMAND_NEEDLE_MADE || code == NDLI_COMMAND_NEEDLE_GONE)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "needle %d was %s while this was recorded: what follows cannot be "
                        "played",
                        ints[1], code == NDLI_COMMAND_NEEDLE_MADE ? "made" : "destroyed");
    return sbi_fail(error, SB_ERROR_FORMAT, "the recording holds a command of needles that there is not");
}

/* ==== src/needle/needle.c ==== */
/* needle: making and releasing needles. */


#include <limits.h>
#include <string.h>

/* ---- definition ---- */

enum { NDLI_NEEDLE_COOKIE = 0x6e646c65, NDLI_LEAST_NODES = 8 };

NDL_API ndl_needle_def ndl_default_needle_def(void)
{
    ndl_needle_def def;
    memset(&def, 0, sizeof def);
    def.follow = NDL_EMBED;
    def.length = (sb_real)0.05;
    def.capacity = 128;
    ndl_rod_section_preset(NDL_STYLET_18G, &def.section);
    def.damping_stretch = def.damping_bending = (sb_real)1e-4;
    def.bevel.law = NDL_BEVEL_CURVATURE;
    def.bevel.guide = (sb_real)0.005;
    def.bevel.lag = (sb_real)0.1;
    def.entry_slip = NDLI_ENTRY_SLIP;
    def.max_trials = 10;
    def.cookie = NDLI_NEEDLE_COOKIE;
    return def;
}

static sb_result ndli_needle_check_frictions(const ndl_needle_def *def, sb_error *error)
{
    if (def->friction_count < 0 || (def->friction_count > 0 && !def->frictions))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "frictions has no entries");
    for (int i = 0; i < def->friction_count; i++) {
        const ndl_friction *f = def->frictions + i;
        const sb_real values[5] = {f->friction, f->viscous, f->cutting, f->twist_stiffness, f->twist_friction};
        static const char *const names[5] = {"friction", "viscous", "cutting", "twist_stiffness", "twist_friction"};
        for (int k = 0; k < 5; k++)
            if (!sb_is_finite(values[k]) || values[k] < 0)
                return sbi_fail(error, SB_ERROR_ARGUMENT, "%s of region %d is %g, not 0 or more", names[k], i,
                                (double)values[k]);
    }
    return SB_OK;
}

static sb_result ndli_needle_check_membranes(const ndl_needle_def *def, sb_error *error)
{
    if (def->membrane_count < 0 || (def->membrane_count > 0 && !def->membranes))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "membranes has no entries");
    for (int i = 0; i < def->membrane_count; i++) {
        const ndl_membrane *m = def->membranes + i;
        if (!sb_is_finite(m->strength) || m->strength < 0 || !(m->thickness > 0) || !sb_is_finite(m->thickness))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "membrane %d has strength %g and thickness %g", i,
                            (double)m->strength, (double)m->thickness);
        if (m->regions[0] == m->regions[1])
            return sbi_fail(error, SB_ERROR_ARGUMENT, "membrane %d has region %d on both sides", i, m->regions[0]);
    }
    return SB_OK;
}

/* Ways of a bevel turn by two radians at most within an edge. */
static sb_result ndli_needle_check_bevel(const ndl_needle_def *def, double edge, sb_error *error)
{
    const ndl_bevel *bevel = &def->bevel;
    sb_real curvature;
    sb_result result =
        ndl_bevel_curvature(bevel, 0, bevel->law == NDL_BEVEL_ANGLE ? bevel->guide : (sb_real)edge, &curvature);
    if (result == SB_OK && (!(bevel->lag > 0) || !(fabs((double)curvature) * edge <= 2)))
        result = SB_ERROR_ARGUMENT;
    if (result != SB_OK)
        return sbi_fail(error, result, "bevel: law %d, angle %g, guide %g, curvature %g, lag %g with edges of %g m",
                        (int)bevel->law, (double)bevel->angle, (double)bevel->guide, (double)bevel->curvature,
                        (double)bevel->lag, edge);
    return SB_OK;
}

static sb_result ndli_needle_check(const ndl_needle_def *def, sb_error *error)
{
    sb_result result;
    if (def->cookie != NDLI_NEEDLE_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def was not made by ndl_default_needle_def");
    if (!def->body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "body is NULL");
    if (!sbi_body_is_implicit(def->body))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "needles need implicit steps: the body's integrator is explicit");
    if (!sb_v3_is_finite(def->base) || !sb_v3_is_finite(def->direction) || !sb_v3_is_finite(def->director) ||
        !sb_v3_is_finite(def->gravity))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "base, direction, director or gravity is not finite");
    if (!(sb_v3_norm(def->direction) > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "direction has no length");
    if (!(def->length > 0) || !sb_is_finite(def->length))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "length is %g, not above 0", (double)def->length);
    if (!(def->edge_length >= 0) || !sb_is_finite(def->edge_length))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "edge_length is %g, not 0 or more", (double)def->edge_length);
    if (def->capacity < NDLI_LEAST_NODES)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "capacity is %d, below %d", def->capacity, (int)NDLI_LEAST_NODES);
    if (!(def->bend_length >= 0) || !(def->bend_length < def->length) || !sb_is_finite(def->bend_curvature) ||
        sb_abs(def->bend_curvature) * def->bend_length > 3)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "bend_length is %g and bend_curvature %g", (double)def->bend_length,
                        (double)def->bend_curvature);
    if (!(def->entry_slip >= 0) || !(def->entry_slip <= NDLI_ENTRY_SLIP))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "entry_slip is %g, not in [0, %g]", (double)def->entry_slip,
                        (double)NDLI_ENTRY_SLIP);
    if (def->max_trials < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_trials is %d", def->max_trials);
    if (def->follow != NDL_REMESH && def->follow != NDL_EMBED)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "follow is %d", (int)def->follow);
    result = ndli_needle_check_frictions(def, error);
    return result == SB_OK ? ndli_needle_check_membranes(def, error) : result;
}

/* ---- the site ---- */

/* The remesher's part of the state comes first: its name does, too. */
static sb_result ndli_site_make_remesh(struct ndli_site *site, sb_error *error)
{
    ndl_remesh_def def = ndl_default_remesh_def();
    sb_result result;
    def.allocator = site->allocator;
    def.body = site->body;
    def.max_needles = NDL_MAX_NEEDLES;
    result = ndl_remesh_create(&def, &site->remesh, error);
    if (result != SB_OK)
        return result;
    site->mesh = ndli_remesh_topology(site->remesh);
    site->mean_edge = ndli_site_mean_edge(site->mesh);
    return SB_OK;
}

static sb_result ndli_site_make_bed(struct ndli_site *site, sb_error *error)
{
    sb_result result = ndli_site_create_bed(site, &site->bed, error);
    if (result == SB_OK)
        site->mean_edge = site->bed.mean_edge;
    return result;
}

/* Something touches the body that did not when its needles were made. */
static int ndli_site_reserve_kept(void *user) { return ndli_needle_reserve_undo((struct ndli_site *)user, NULL); }

static sb_result ndli_site_fill(struct ndli_site *site, sb_error *error)
{
    sbi_state_part part = ndli_site_part(site);
    sbi_touch_keeper keeper;
    sb_result result = site->embeds ? ndli_site_make_bed(site, error) : ndli_site_make_remesh(site, error);
    part.replay = ndli_needle_replay;
    if (result != SB_OK)
        return result;
    result = ndli_site_listen(site, error);
    if (result == SB_OK)
        result = sbi_body_join(site->body, &part, error);
    keeper.user = site;
    keeper.reserve = ndli_site_reserve_kept;
    if (result == SB_OK)
        sbi_body_set_touch_keeper(site->body, &keeper);
    return result;
}

static void ndli_site_end(struct ndli_site *site)
{
    sbi_body_set_touch_keeper(site->body, NULL);
    ndli_site_leave(site);
    ndli_site_free(site);
}

/* The site of a body, made if there is none yet. */
static sb_result ndli_site_make(const ndl_needle_def *def, struct ndli_site **site, sb_error *error)
{
    sb_body *body = def->body;
    const sb_allocator *allocator = sbi_body_allocator(body);
    struct ndli_site *made = ndli_needle_site(body);
    sb_result result;
    if (made && made->embeds != (def->follow == NDL_EMBED))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the body's other needles are held the other way: see def.follow");
    if (made) {
        *site = made;
        return ndli_needle_look(made, error);
    }
    made = (struct ndli_site *)sbi_alloc_zeroed(allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the needles of a body");
    made->body = body;
    made->embeds = def->follow == NDL_EMBED;
    made->allocator = *allocator;
    result = ndli_site_fill(made, error);
    if (result != SB_OK)
        ndli_site_end(made);
    else
        *site = made;
    return result;
}

/* ---- creation ---- */

/* Length of the bends that the body's tissue makes of a needle (m). */
static double ndli_needle_wave(const struct ndli_site *site, const ndl_needle_def *def)
{
    ndl_rod_stiffness stiffness = def->stiffness ? *def->stiffness : ndl_rod_stiffness_of(&def->section);
    double bending = 0.5 * ((double)stiffness.bending[0] + (double)stiffness.bending[1]);
    return ndli_held_wave(bending, (double)def->section.radius, (double)sbi_body_young(site->body), site->mean_edge);
}

/* Edges of a rod that springs hold are short beside the bends that these make. */
static double ndli_needle_usual_edge(const struct ndli_site *site, const ndl_needle_def *def)
{
    double most = site->mean_edge, least = most / 8;
    return site->embeds ? fmin(fmax(0.125 * ndli_needle_wave(site, def), least), most) : most;
}

/* The shape at rest: straight, then a circle towards m2. */
static void ndli_needle_rest_nodes(const ndl_needle_def *def, int edges, double sleeve, sb_vec3 *nodes)
{
    ndl_tip_pose pose;
    sb_real straight = def->length - def->bend_length;
    ndli_v3 t = ndli_from(def->direction);
    t = ndli_scale(1 / ndli_norm(t), t);
    pose.frame.t = ndli_to(t);
    pose.frame.m1 = ndli_to(ndli_rod_across(ndli_from(def->director), t));
    pose.frame.m2 = sb_v3_cross(pose.frame.t, pose.frame.m1);
    nodes[0] = sb_v3_madd(def->base, (sb_real)-sleeve, pose.frame.t);
    pose.position = sb_v3_madd(def->base, straight, pose.frame.t);
    for (int i = 0; i <= edges; i++) {
        sb_real s = def->length * (sb_real)i / (sb_real)edges;
        nodes[i + 1] = sb_v3_madd(def->base, s, pose.frame.t);
        if (s > straight)
            nodes[i + 1] = ndl_helix_pose(&pose, def->bend_curvature, 0, s - straight).position;
    }
}

static sb_result ndli_needle_make_rod(ndl_needle *needle, const ndl_needle_def *def, sb_error *error)
{
    ndl_rod_def rod = ndl_default_rod_def();
    double wanted = (double)def->length / needle->edge_length;
    sb_vec3 *nodes;
    sb_result result;
    int edges;
    if (!(wanted < def->capacity - 3))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "capacity is %d, too little for %g m by edges of %g m", def->capacity,
                        (double)def->length, needle->edge_length);
    edges = sbi_max_int(2, (int)(wanted + 0.999));
    nodes = (sb_vec3 *)sbi_alloc(&def->allocator, (size_t)edges + 2, sizeof(sb_vec3));
    if (!nodes)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a needle");
    ndli_needle_rest_nodes(def, edges, needle->edge_length, nodes);
    rod.nodes = nodes;
    rod.node_count = edges + 2;
    rod.capacity = def->capacity;
    rod.section = def->section;
    rod.stiffness = def->stiffness;
    rod.rest = def->bend_length > 0 && def->bend_curvature != 0 ? NDL_REST_SHAPE : NDL_REST_STRAIGHT;
    rod.director = def->director;
    rod.gravity = def->gravity;
    rod.damping_stretch = def->damping_stretch;
    rod.damping_bending = def->damping_bending;
    rod.allocator = def->allocator;
    result = ndl_rod_create(&rod, &needle->rod, error);
    sbi_free(&def->allocator, nodes);
    return result;
}

static void ndli_needle_layout(ndl_needle *needle, const ndl_needle_def *def, sbi_arena *arena)
{
    size_t n = (size_t)def->capacity;
    needle->places = (ndli_v3 *)sbi_arena_take(arena, n, sizeof(ndli_v3));
    needle->place_tangents = (ndli_v3 *)sbi_arena_take(arena, n, sizeof(ndli_v3));
    needle->frictions = (ndl_friction *)sbi_arena_take(arena, (size_t)def->friction_count, sizeof(ndl_friction));
    needle->capsules = (ndli_capsule *)sbi_arena_take(arena, (size_t)def->membrane_count, sizeof(ndli_capsule));
    if (def->follow == NDL_EMBED) {
        needle->arc = (double *)sbi_arena_take(arena, n, sizeof(double));
        needle->stretch = (double *)sbi_arena_take(arena, n, sizeof(double));
        needle->holds = (struct ndli_hold *)sbi_arena_take(arena, n, sizeof(struct ndli_hold));
        needle->track.capacity = (int)(NDLI_TRACK_POINTS * n);
        needle->track.X = (ndli_v3 *)sbi_arena_take(arena, NDLI_TRACK_POINTS * n, sizeof(ndli_v3));
        needle->track.arc = (double *)sbi_arena_take(arena, NDLI_TRACK_POINTS * n, sizeof(double));
        needle->track.elements = (int *)sbi_arena_take(arena, NDLI_TRACK_POINTS * n, sizeof(int));
    }
    needle->gap = (ndli_v3 *)sbi_arena_take(arena, n, sizeof(ndli_v3));
    needle->old_gap = (ndli_v3 *)sbi_arena_take(arena, n, sizeof(ndli_v3));
    needle->old_X = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    needle->path = (int *)sbi_arena_take(arena, n, sizeof(int));
    needle->old_contact = (ndli_v3 *)sbi_arena_take(arena, n, sizeof(ndli_v3));
    needle->old_path = (int *)sbi_arena_take(arena, n, sizeof(int));
    needle->old_state = (unsigned char *)sbi_arena_take(arena, n, 1);
}

static sb_result ndli_needle_make_memory(ndl_needle *needle, const ndl_needle_def *def, sb_error *error)
{
    sbi_arena arena = {NULL, 0, 0};
    ndli_needle_layout(needle, def, &arena);
    needle->memory = arena.overflow ? NULL : sbi_alloc_zeroed(&def->allocator, 1, arena.used);
    if (!needle->memory)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a needle of %d nodes", def->capacity);
    arena.base = (unsigned char *)needle->memory;
    arena.used = 0;
    ndli_needle_layout(needle, def, &arena);
    if (!ndli_line_create(&needle->line, needle->rod, &def->allocator))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a needle of %d nodes", def->capacity);
    needle->line.path = needle->path;
    needle->line.holds = needle->holds;
    return SB_OK;
}

/* A needle begins outside: neither its tip nor a crossing of the skin is in the tissue. */
static sb_result ndli_needle_check_outside_bed(const ndl_needle *needle, sb_error *error)
{
    const ndli_bed *bed = &needle->site->bed;
    const ndl_rod *rod = needle->rod;
    ndli_place place;
    sb_vec3 at;
    for (int i = 1; i < rod->node_count; i++)
        if (ndli_bed_hit(bed, ndli_to(rod->x[i - 1]), ndli_to(rod->x[i]), &place, &at) ||
            ndli_bed_hit(bed, ndli_to(rod->x[i]), ndli_to(rod->x[i - 1]), &place, &at))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "the needle's edge %d crosses the tissue's skin already", i - 1);
    return ndli_bed_holds_in_space(bed, ndli_to(rod->x[rod->node_count - 1]))
               ? sbi_fail(error, SB_ERROR_ARGUMENT, "the needle's tip is in the tissue already")
               : SB_OK;
}

static sb_result ndli_needle_check_outside(const ndl_needle *needle, sb_error *error)
{
    const ndli_topology *mesh = needle->site->mesh;
    const ndl_rod *rod = needle->rod;
    sb_vec3 tip = ndli_to(rod->x[rod->node_count - 1]);
    ndl_surface_hit hit;
    for (int i = 1; i < rod->node_count; i++) /* inwards, or outwards from a sleeve within */
        if (ndli_topology_hit(mesh, ndli_to(rod->x[i - 1]), ndli_to(rod->x[i]), &hit) ||
            ndli_topology_hit(mesh, ndli_to(rod->x[i]), ndli_to(rod->x[i - 1]), &hit))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "the needle's edge %d crosses the tissue's skin already", i - 1);
    for (int t = 0; t < mesh->tet_end; t++)
        if (mesh->tets[4 * (size_t)t] >= 0)
            return ndli_topology_find(mesh, mesh->x, tip, t, NULL) < 0
                       ? SB_OK
                       : sbi_fail(error, SB_ERROR_ARGUMENT, "the needle's tip is in the tissue already");
    return SB_OK;
}

static void ndli_needle_fill(ndl_needle *needle, const ndl_needle_def *def)
{
    const ndl_rod *rod = needle->rod;
    needle->bevel = def->bevel;
    if (def->friction_count)
        memcpy(needle->frictions, def->frictions, (size_t)def->friction_count * sizeof(ndl_friction));
    needle->friction_count = def->friction_count;
    needle->cutting_at = def->cutting;
    needle->cutting_user = def->cutting_user;
    needle->max_trials = def->max_trials;
    needle->entry_slip = def->entry_slip;
    needle->wave = ndli_needle_wave(needle->site, def);
    needle->outlet = rod->x[1];
    needle->axis = rod->tangent[0];
    needle->line.first = rod->node_count;
}

static sb_result ndli_needle_build(ndl_needle *needle, struct ndli_site *site, const ndl_needle_def *def,
                                   sb_error *error)
{
    sb_result result;
    int bad;
    needle->allocator = def->allocator;
    needle->site = site;
    needle->radius = (double)def->section.radius;
    needle->edge_length = def->edge_length > 0 ? (double)def->edge_length : ndli_needle_usual_edge(site, def);
    needle->track.spacing = needle->edge_length / (int)NDLI_TRACK_POINTS;
    result = ndli_needle_check_bevel(def, needle->edge_length, error);
    if (result == SB_OK)
        result = ndli_needle_make_rod(needle, def, error);
    if (result == SB_OK)
        result = ndli_needle_make_memory(needle, def, error);
    if (result == SB_OK)
        result = site->embeds ? ndli_needle_check_outside_bed(needle, error) : ndli_needle_check_outside(needle, error);
    if (result != SB_OK)
        return result;
    if (!ndli_needle_make_capsules(needle, def->membranes, def->membrane_count, &bad))
        return bad < 0 ? sbi_fail(error, SB_ERROR_MEMORY, "no memory for a membrane")
                       : sbi_fail(error, SB_ERROR_ARGUMENT, "membrane %d: no face lies between regions %d and %d", bad,
                                  def->membranes[bad].regions[0], def->membranes[bad].regions[1]);
    ndli_needle_fill(needle, def);
    needle->index = ndli_site_free_index(site);
    result = site->embeds ? SB_OK : ndl_remesh_reserve(site->remesh, needle->index, def->capacity, error);
    if (result == SB_OK && !(ndli_site_reserve(site, def->capacity) && ndli_needle_reserve_undo(site, needle)))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a needle of %d nodes", def->capacity);
    if (result == SB_OK && site->node_room > (size_t)(INT_MAX / NDLI_LINE_UNKNOWNS))
        return sbi_fail(error, SB_ERROR_MEMORY, "capacities of all needles are over %d nodes",
                        INT_MAX / NDLI_LINE_UNKNOWNS);
    return result == SB_OK ? sbi_body_reserve_guest(site->body, NDLI_LINE_UNKNOWNS * (int)site->node_room,
                                                    (int)site->coupled_room, error)
                           : result;
}

static void ndli_needle_release(ndl_needle *needle)
{
    sb_allocator allocator = needle->allocator;
    for (int i = 0; i < needle->capsule_count; i++)
        sb_surface_destroy(needle->capsules[i].surface);
    ndli_line_free(&needle->line);
    ndl_rod_destroy(needle->rod);
    sbi_free(&allocator, needle->memory);
    sbi_free(&allocator, needle);
}

static void ndli_needle_join(ndl_needle *needle)
{
    needle->site->needles[needle->index] = needle;
    needle->site->count++;
}

NDL_API sb_result ndl_needle_create(const ndl_needle_def *def, ndl_needle **needle, sb_error *error)
{
    struct ndli_site *site = NULL;
    ndl_needle *made;
    sb_result result;
    if (!def || !needle)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def or needle is NULL");
    result = ndli_needle_check(def, error);
    if (result == SB_OK)
        result = ndli_site_make(def, &site, error);
    if (result == SB_OK)
        result = ndli_needle_finish_undo(site, error);
    if (result != SB_OK)
        return result;
    if (site->count == NDL_MAX_NEEDLES)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the body has %d needles already", (int)NDL_MAX_NEEDLES);
    made = (ndl_needle *)sbi_alloc_zeroed(&def->allocator, 1, sizeof *made);
    result =
        made ? ndli_needle_build(made, site, def, error) : sbi_fail(error, SB_ERROR_MEMORY, "no memory for a needle");
    if (result == SB_OK) {
        ndli_needle_join(made);
        ndli_needle_tell_life(made, NDLI_COMMAND_NEEDLE_MADE);
        *needle = made;
        return SB_OK;
    }
    if (made)
        ndli_needle_release(made);
    if (site->count == 0)
        ndli_site_end(site);
    return result;
}

NDL_API void ndl_needle_destroy(ndl_needle *needle)
{
    struct ndli_site *site;
    if (!needle)
        return;
    site = needle->site;
    (void)ndli_needle_finish_undo(site, NULL);
    site->undo_waits = 0; /* what is kept is of all needles: from here on it fits no more */
    ndli_needle_tell_life(needle, NDLI_COMMAND_NEEDLE_GONE);
    sbi_body_mute(site->body);
    if (!site->embeds)
        ndli_remesh_let_go(site->remesh, needle->index);
    sbi_body_unmute(site->body);
    site->needles[needle->index] = NULL;
    if (--site->count == 0)
        ndli_site_end(site);
    ndli_needle_release(needle);
}

#endif /* NDL_IMPLEMENTATION */

/* ==== src/needle/../softbody/end.h ==== */
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
