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
 * OPTIONS are softbody.h's. SB_REAL: exported names of a float build end in _f32. SB_STATIC makes this header static,
 * too; NDL_STATIC makes only this one so.
 *
 * WHAT IT DOES NOT DO
 *
 * In this version: needles alone (rods), tissue that moves and whose mesh follows a needle's tip, and steering plans; not
 * yet needles that feel the tissue.
 *
 * A FIRST PROGRAM
 *
 * A brachytherapy stylet, clamped in a hand piece, sags under its weight and a push at its tip; then its hand piece is
 * turned and moved, and the force that a hand feels is read:
 *
 *     ```c
 *     #define SB_IMPLEMENTATION
 *     #define NDL_IMPLEMENTATION
 *     #include "needle.h"
 *     #include <stdio.h>
 *
 *     int main(void)
 *     {
 *         sb_vec3 nodes[21];
 *         for (int i = 0; i < 21; i++)
 *             nodes[i] = sb_v3(0.01 * i, 0, 0);                       // 20 cm, base first
 *
 *         ndl_rod_def def = ndl_default_rod_def();                    // a straight 18 G stylet, clamped at its base
 *         def.nodes = nodes;
 *         def.node_count = 21;
 *         def.gravity = sb_v3(0, 0, -9.81);
 *         ndl_rod *rod = NULL;
 *         sb_error error;
 *         if (ndl_rod_create(&def, &rod, &error) != SB_OK) {
 *             fprintf(stderr, "%s\n", error.message);
 *             return 1;
 *         }
 *
 *         sb_vec3 tip, force, torque;
 *         ndl_rod_info info;
 *         ndl_rod_set_force(rod, 20, sb_v3(0, 0.2, 0));               // N
 *         if (ndl_rod_solve_static(rod, NULL, &info) != SB_OK)
 *             return 1;
 *         ndl_rod_tip(rod, &tip, NULL);
 *         printf("the tip is pushed by %.2f mm and sags by %.2f mm\n", 1e3 * tip.y, -1e3 * tip.z);
 *
 *         for (int frame = 1; frame <= 60; frame++) {
 *             sb_vec3 base = sb_v3(0.0005 * frame, 0, 0);             // the hand piece goes forward and turns
 *             sb_real sine, cosine;
 *             sb_sin_cos(0.02 * frame, &sine, &cosine);
 *             ndl_rod_hold_base(rod, base, sb_v3(1, 0, 0), sb_v3(0, cosine, sine), NULL, NULL);
 *             if (ndl_rod_step(rod, 1.0 / 60, &info) != SB_OK)
 *                 fprintf(stderr, "%s\n", info.error.message);        // the step was undone; go on
 *             ndl_rod_base_wrench(rod, &force, &torque);              // what the hand exerts on the needle
 *         }
 *         printf("the hand holds %.4f N and %.5f N m\n", force.z, torque.y);
 *         ndl_rod_destroy(rod);
 *         return 0;
 *     }
 *     ```
 *
 * CONCEPTS
 *
 * Units are SI. Results, errors, memory, threads and determinism are as softbody.h says in its top comment.
 *
 * ndl_rod      an elastic rod: a chain of nodes, base first, that stretches, bends and twists. Supports (ndl_rod_hold,
 *              ndl_rod_turn, ndl_rod_hold_base) and loads stay until changed; ndl_rod_step moves it,
 *              ndl_rod_solve_static finds its equilibrium. Straight or pre-bent at rest.
 * frames       each edge has a material frame (m1, m2, t), t along it. A bevel is a direction in the frame of the last
 *              edge: with a free tip it turns with the base.
 *
 * LICENCE
 *
 * MIT or public domain, as you like; the texts are at the end of this file.
 */
