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
