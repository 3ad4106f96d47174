/* needle.h 0.2.0: flexible needles in soft tissue
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
 * OPTIONS are softbody.h's. SB_REAL: exported names of a float build end in _f32. SB_STATIC makes this header static,
 * too; NDL_STATIC makes only this one so.
 *
 * A FIRST PROGRAM
 *
 *     ```c
 *     #define SB_IMPLEMENTATION
 *     #define NDL_IMPLEMENTATION
 *     #include "needle.h"
 *     #include <stdio.h>
 *
 *     int main(void)
 *     {
 *         printf("needle.h %s\n", NDL_VERSION_STRING);
 *         return 0;
 *     }
 *     ```
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
#define ndl_rod_step ndl_rod_step_f32
#define ndl_default_rod_static_options ndl_default_rod_static_options_f32
#define ndl_rod_solve_static ndl_rod_solve_static_f32
#define ndl_rod_set_positions ndl_rod_set_positions_f32
#define ndl_rod_set_velocities ndl_rod_set_velocities_f32
#define ndl_rod_split_edge ndl_rod_split_edge_f32
#define ndl_rod_merge_node ndl_rod_merge_node_f32
#define ndl_rod_feed ndl_rod_feed_f32
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
#define ndl_rod_base_wrench ndl_rod_base_wrench_f32
#endif
#endif

#endif /* NDLI_NAMES_H */

/* ==== src/needle/api.h ==== */
/* api: version and linkage of needle.h. Results, errors, allocator, vectors and the scalar type are softbody.h's. */
#ifndef NDL_API_H
#define NDL_API_H


#define NDL_VERSION_MAJOR 0
#define NDL_VERSION_MINOR 2
#define NDL_VERSION_PATCH 0
#define NDL_VERSION_STRING "0.2.0"

#if NDL_VERSION_MAJOR != SB_VERSION_MAJOR || NDL_VERSION_MINOR != SB_VERSION_MINOR || \
    NDL_VERSION_PATCH != SB_VERSION_PATCH
#error "needle.h and softbody.h are of different versions: take both from one release"
#endif
#if defined(NDL_IMPLEMENTATION) && !defined(SB_IMPLEMENTATION)
#error "needle.h: define NDL_IMPLEMENTATION in the file that defines SB_IMPLEMENTATION"
#endif

/* NDL_API: public functions; static under SB_STATIC or NDL_STATIC. NDLI_API: internal functions; static in the shipped
 * header, extern when the rooms are compiled apart. */
#if defined(SB_STATIC) || defined(NDL_STATIC)
#define NDL_API static SBI_UNUSED
#elif defined(__cplusplus)
#define NDL_API extern "C"
#else
#define NDL_API extern
#endif
#if defined(SB_SPLIT_BUILD)
#define NDLI_API extern
#else
#define NDLI_API static SBI_UNUSED
#endif

#endif /* NDL_API_H */

/* ==== src/needle/rod.h ==== */
/* rod: a discrete elastic rod: a needle's stretching, bending and twisting, with or without tissue. Floor 3.
 *
 * A rod is a chain of nodes x_0 (base) ... x_n-1 (tip) and the edges e_j = x_j+1 - x_j between them. Each edge carries
 * a material frame (m1, m2, t): t along the edge, m1 and m2 across it, which tells how the rod is turned about its own
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
    NDL_STYLET_18G = 1,   /* 18-gauge brachytherapy stylet: steel wire of 1.27 mm */
    NDL_NITINOL_083 = 2,  /* steerable nitinol wire of 0.83 mm (the needle of Webster et al. 2005, Int. Symp.
                           * Experimental Robotics, and of the phantom studies after it) */
    NDL_HYPODERMIC_22G = 3 /* 22-gauge steel tube, 0.7176 mm outside, 0.413 mm inside */
} ndl_rod_preset;

/* The section of a known needle. Diameters: regular-wall gauge table after the Birmingham wire gauge (18 G: 1.270 mm, 22 G:
 * 0.7176 / 0.413 mm). Steel: AISI 304, annealed, 193 GPa, 0.29, 8000 kg/m^3. Nitinol: austenite, 75 GPa, 0.33,
 * 6450 kg/m^3 (makers' sheets: 75 to 83 GPa; linear up to a strain of about 1 % only). SB_ERROR_ARGUMENT for an unknown
 * preset leaves *section untouched. */
NDL_API sb_result ndl_rod_section_preset(ndl_rod_preset preset, ndl_rod_section *section);

/* Stiffnesses of a rod; ndl_rod_stiffness_of makes them from a section. */
typedef struct ndl_rod_stiffness {
    sb_real stretch;    /* EA (N), > 0 */
    sb_real bending[2]; /* EI (N m^2), > 0, against curvature towards m1 and towards m2 */
    sb_real twist;      /* GJ (N m^2), > 0 */
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
    const sb_vec3 *nodes;   /* [node_count] (m) first positions, base first; neighbours apart, no edge turned back on
                             * the one before (turns below 2.8 rad). Read during creation only, as all pointers here */
    int node_count;         /* >= 2 */
    int capacity;           /* most nodes the rod will ever have (see splitting), >= node_count; default 0: node_count */
    ndl_rod_section section; /* default NDL_STYLET_18G */
    const ndl_rod_stiffness *stiffness; /* overrules the section; default NULL */
    ndl_rod_rest rest;      /* default NDL_REST_STRAIGHT */
    const sb_real *rest_curvature; /* [node_count][2] (1/m) for NDL_REST_CURVATURE: curvature towards m1 and towards m2
                             * at each node; those of the two ends are not used */
    sb_vec3 director;       /* m1 of the first edge, projected to be across it and made a unit vector; default 0: any */
    int clamped;            /* 1 (default): nodes 0 and 1 and the frame of edge 0 are held. 0: free */
    sb_vec3 gravity;        /* m/s^2; default 0 */
    sb_real damping_stretch; /* s, >= 0: viscous stress is this times the rate of the elastic one; default 1e-4 */
    sb_real damping_bending; /* s, >= 0; the same for bending. It acts on the rate of the curvature vector, so that it
                             * also slows, weakly, a bent rod that spins as a whole; default 1e-4 */
    int max_newton;         /* Newton iterations of a step: 1 is one linear system, as in a coupled needle; default 30 */
    sb_real tolerance;      /* out-of-balance force that a step leaves, relative to the largest, (0, 1); default 1e-6 */
    sb_allocator allocator; /* default malloc */
    unsigned cookie;        /* set by ndl_default_rod_def; a def made without it is refused */
} ndl_rod_def;

NDL_API ndl_rod_def ndl_default_rod_def(void);

/* Creates a rod at rest, with no twist but what its rest shape asks for. All memory it will ever need is taken here. On failure
 * *rod is untouched: SB_ERROR_ARGUMENT and SB_ERROR_NOT_FINITE (field or node named), SB_ERROR_MESH (node named: an
 * edge without length, or one turned back), SB_ERROR_MEMORY. */
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

/* ---- motion ---- */

/* What a step or static solve did; every call writes every field. */
typedef struct ndl_rod_info {
    int newton_iterations;
    sb_real residual;    /* largest out-of-balance force over the largest force at work, at the last check */
    int capped;          /* 1: max_newton was reached before the tolerance, and the last state was taken */
    int damped;          /* 1: the step was taken by implicit Euler, because Newmark would have gained energy */
    sb_error error;
} ndl_rod_info;

/* Advances the rod by dt (s, > 0) with Newmark's average acceleration (beta 1/4, gamma 1/2: second order),
 *     M a' = f(x', v'),  x' = x + dt v + dt^2 (a + a')/4,  v' = v + dt (a + a')/2,
 * by Newton's method with a banded direct solve, frames eliminated together with the nodes; each iteration lowers the
 * step's potential. While supports and loads do not change the energy is watched: a step that would raise it above
 * where it was when they last changed by more than 1 % of what is in motion and in strain is taken by implicit Euler,
 * which only loses energy. Without damping and supports linear momentum is kept to rounding.
 * info may be NULL. On failure (SB_ERROR_ARGUMENT; SB_ERROR_UNCONSTRAINED: a torque about a rod no edge of which is
 * held; SB_ERROR_DIVERGED) the rod is as before the call, to the last bit. Allocates nothing; cost grows with
 * node_count, about 15 us for 20 nodes and an iteration. */
NDL_API sb_result ndl_rod_step(ndl_rod *rod, sb_real dt, ndl_rod_info *info);

/* How a static solve goes about its work. Start from ndl_default_rod_static_options(). */
typedef struct ndl_rod_static_options {
    int max_newton;      /* >= 1; default 500 */
    sb_real tolerance;   /* largest out-of-balance force over the largest force at work, (0, 1); default 1e-9, or what
                          * rounding of positions leaves of it */
    unsigned cookie;     /* set by ndl_default_rod_static_options */
} ndl_rod_static_options;

NDL_API ndl_rod_static_options ndl_default_rod_static_options(void);

/* Finds the equilibrium nearest downhill under the present loads and supports; velocities become 0. Newton with the
 * exact Hessian of stretch, bending and twist where that is positive definite, Gauss-Newton where it is not; steps turn
 * edges rather than stretch them, and a line search lets the energy only fall. Supports move there in pieces when their way is long. A straight rod under more
 * than its buckling load is in equilibrium and stays so until something pushes it aside.
 * options and info may be NULL. On failure (SB_ERROR_ARGUMENT; SB_ERROR_UNCONSTRAINED: the supports leave the rod free
 * to move; SB_ERROR_NOT_CONVERGED; SB_ERROR_DIVERGED) the rod is as before the call. Allocates nothing. */
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
/* Feeds `length` (m, either sign) of rod through the base: edge 1 gets longer or shorter at rest. SB_ERROR_ARGUMENT when
 * nothing would be left of it, or the rod has no edge 1. */
NDL_API sb_result ndl_rod_feed(ndl_rod *rod, sb_real length);

/* ---- readings: no allocation ---- */
NDL_API int ndl_rod_node_count(const ndl_rod *rod);
NDL_API const sb_vec3 *ndl_rod_positions(const ndl_rod *rod);  /* [node_count] (m), valid until destroyed */
NDL_API const sb_vec3 *ndl_rod_velocities(const ndl_rod *rod); /* [node_count] (m/s) */
NDL_API sb_real ndl_rod_mass(const ndl_rod *rod, int node);    /* kg */
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
} ndl_rod_energy;
NDL_API ndl_rod_energy ndl_rod_energies(const ndl_rod *rod);
/* Elastic and viscous force (N) on every node from the present state, forces[node_count]: minus the gradient of the
 * elastic energy at fixed material frames, and the damping. */
NDL_API void ndl_rod_forces(ndl_rod *rod, sb_vec3 *forces);
/* Force (N) of the supports on each node in the last step or static solve, 0 where free; [node_count]. */
NDL_API const sb_vec3 *ndl_rod_reactions(const ndl_rod *rod);
/* Torque (N m) about the tangent that holds an edge's frame, in the last step or static solve; 0 where free. */
NDL_API sb_real ndl_rod_reaction_torque(const ndl_rod *rod, int edge);
/* What holds the base, as force (N) and torque (N m) about node 0 on the rod: what a hand feels is the opposite. */
NDL_API void ndl_rod_base_wrench(const ndl_rod *rod, sb_vec3 *force, sb_vec3 *torque);

#endif /* NDL_ROD_H */

#endif /* NEEDLE_H */

#if defined(NDL_IMPLEMENTATION) && !defined(NDL_IMPLEMENTATION_DONE)
#define NDL_IMPLEMENTATION_DONE

/* ==== src/needle/real3.h ==== */
/* real3: 3-vectors and 3x3 matrices of double, for rods. Floor 0, internal. A rod is a million times stiffer along itself
 * than across: float holds neither its strains nor its matrices, so rods are computed in double in float builds, too. */
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
SB_INLINE ndli_v3 ndli_madd(ndli_v3 a, double s, ndli_v3 b) { return ndli_v(a.x + s * b.x, a.y + s * b.y, a.z + s * b.z); }
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
/* band: symmetric positive definite systems of small bandwidth, as chains of nodes make them. Floor 1, internal. */
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

/* ==== src/needle/rod_state.h ==== */
/* rod_state: what is inside a rod. Floor 3, internal: rod.c keeps it, rod_force.c reads forces from it, rod_step.c moves
 * it; rooms above couple it to tissue and change its nodes.
 *
 * State: x, v, a, director, theta. The directors d_j are a Bishop frame: each is its predecessor carried over by parallel
 * transport, so that the twist at node i is theta_i - theta_i-1. Within a step each edge carries its director with
 * itself instead (that keeps derivatives local); the reference twist that then arises between neighbours is folded
 * into theta when the step is taken (ndli_rod_moved). */
#ifndef NDL_ROD_STATE_H
#define NDL_ROD_STATE_H


/* Geometry of a rod in a shape that is tried: all that energies and their derivatives are made of. */
typedef struct ndli_rod_shape {
    ndli_v3 *tangent;  /* [edges] */
    double *length;   /* [edges] (m) */
    ndli_v3 *director; /* [edges] the state's, carried along with the edge */
    ndli_v3 *m1, *m2;  /* [edges] */
    ndli_v3 *binormal; /* [nodes] kb; inner nodes only */
    double *chi;      /* [nodes] 1 + t.t' */
    double *twist;    /* [nodes] (rad) */
} ndli_rod_shape;

/* Second derivatives of the energy, lower half. Blocks of node i with nodes i, i - 1, i - 2. */
typedef struct ndli_rod_matrix {
    ndli_m3 (*node)[3];   /* [nodes] (N/m) */
    ndli_v3 (*cross)[4];  /* [edges] theta_j with nodes j - 1 .. j + 2 (N/rad) */
    double *turn;        /* [edges] theta_j with itself (N m) */
    double *turn_before; /* [edges] theta_j with theta_j-1 */
} ndli_rod_matrix;

struct ndl_rod {
    sb_allocator allocator;
    void *memory;            /* the one block behind the arrays */
    int capacity;
    int node_count;
    double stretch, bending[2], torsion, line_density; /* N, N m^2, N m^2, kg/m */
    int plain;               /* 1: isotropic and straight at rest, so that bending does not see the material frames */
    ndli_v3 gravity;
    double damping_stretch, damping_bending; /* s */
    int max_newton;
    double tolerance;

    ndli_v3 *x, *v, *a;      /* [nodes] */
    ndli_v3 *director;       /* [edges] */
    double *theta;          /* [edges] (rad) material frame from the director, about the tangent; whole turns count */
    ndli_v3 *tangent;        /* [edges] of x */

    double *rest_length;    /* [edges] (m) */
    double (*rest_bend)[2]; /* [nodes] integrated rest curvature (2 tan of half the turn) towards m1 and m2; a density
                              * is this over the cell */
    double *mass;           /* [nodes] (kg) */
    double *cell;           /* [nodes] (m) length that bends at an inner node: half of both edges, of one at a clamp */

    unsigned char *held;     /* [nodes] */
    ndli_v3 *target;         /* [nodes] where held nodes will be, */
    ndli_v3 *target_velocity; /* [nodes] with this velocity */
    unsigned char *has_velocity; /* [nodes] 1: target_velocity was given */
    unsigned char *turn_held; /* [edges] */
    double *turn;           /* [edges] (rad) still to turn in the next step */
    int base_director_set;   /* 1: the base shall be turned so that its m1 becomes base_director */
    ndli_v3 base_director;
    ndli_v3 *force;          /* [nodes] dead loads (N) */
    double *torque;         /* [edges] (N m) */
    ndli_v3 *reaction;       /* [nodes] */
    double *reaction_torque; /* [edges] */

    sb_vec3 *public_x, *public_v, *public_reaction; /* [nodes] what readings return */

    int ledger_open;         /* 1: ledger is the energy (J) when supports or loads last changed */
    double ledger;

    /* what follows holds nothing between calls */
    ndli_rod_shape shape;
    ndli_rod_matrix matrix;
    ndli_v3 *gradient;       /* [nodes] */
    double *turn_gradient;  /* [edges] */
    ndli_v3 *try_x, *try_v, *best_x, *step_x; /* [nodes] */
    double *try_theta, *best_theta, *step_theta; /* [edges] */
    ndli_v3 *predicted, *predicted_velocity; /* [nodes] */
    ndli_m3 *damping_before, *damping_after, *damping_weight; /* [nodes] d kb/d e_i-1, d kb/d e_i, tau times stiffness */
    ndli_v3 *damping_tangent; /* [edges] */
    double *band;           /* [4 nodes][NDLI_ROD_WIDTH + 1] */
    double *unknown;        /* [4 nodes] */
    ndli_v3 *saved_nodes;    /* [NDLI_ROD_SAVED_NODES nodes] copies for undo */
    double *saved_reals;     /* [NDLI_ROD_SAVED_REALS nodes] */
    double *saved_turns;     /* [edges] */
};

/* Unknowns of node i: x_i, theta_i. A bend couples the first of x_i-1 (4 i - 4) to the last of x_i+1 (4 i + 6). */
enum { NDLI_ROD_WIDTH = 10, NDLI_ROD_SAVED_NODES = 6, NDLI_ROD_SAVED_REALS = 2 };

/* What of the second derivatives is wanted. */
enum {
    NDLI_ROD_EXACT = 1,   /* all; otherwise Gauss-Newton bending and twist, safe stretch: positive semidefinite */
    NDLI_ROD_NO_TWIST = 2 /* twist left out: for those who keep frames out of their unknowns and eliminate them, where
                           * a free tip makes it vanish */
};

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* ---- rod_force ---- */

SB_INLINE int ndli_rod_edges(const ndl_rod *rod) { return rod->node_count - 1; }
/* Largest distance of a node from the origin (m): what positions are rounded by. */
NDLI_API double ndli_rod_reach(const ndl_rod *rod);
/* Parallel transport of v from the unit tangent p to the unit tangent q, not opposite to it. */
NDLI_API ndli_v3 ndli_rod_transport(ndli_v3 p, ndli_v3 q, ndli_v3 v);
/* shape = geometry at x and theta, directors carried from the state's. Returns -1, or the first node at which an edge
 * has no length, has turned back on its neighbour, or turned over since the state: no energy there. */
NDLI_API int ndli_rod_set_shape(const ndl_rod *rod, const ndli_v3 *x, const double *theta);
typedef struct ndli_rod_sums {
    double stretch, bend, twist; /* J */
    double noise;                /* J: what rounding of positions leaves unknown of their sum */
} ndli_rod_sums;
/* Elastic energies of rod->shape. */
NDLI_API ndli_rod_sums ndli_rod_shape_energy(const ndl_rod *rod);
/* gradient[nodes] and turn_gradient[edges] (not NULL) of the elastic energy of rod->shape; matrix, when not NULL, its
 * second derivatives by the flags above. */
NDLI_API void ndli_rod_derivatives(const ndl_rod *rod, int flags, ndli_v3 *gradient, double *turn_gradient,
                                   ndli_rod_matrix *matrix);
/* Takes what damping is at rod->shape: damping_before ... damping_tangent. */
NDLI_API void ndli_rod_set_damping_shape(ndl_rod *rod);
/* gradient += C v for that damping; returns v.C v (W). */
NDLI_API double ndli_rod_add_damping_force(const ndl_rod *rod, const ndli_v3 *v, ndli_v3 *gradient);
/* matrix->node += factor C */
NDLI_API void ndli_rod_add_damping_matrix(const ndl_rod *rod, double factor, ndli_rod_matrix *matrix);

/* ---- rod ---- */

/* After x changed: tangents, frames (carried from where the edges were) and quasi-static theta follow. Returns -1, or the
 * node that ndli_rod_set_shape names; nothing has changed then, x aside. */
NDLI_API int ndli_rod_moved(ndl_rod *rod);
/* After rest_length or held changed: masses, and cells. Rest curvature stays integrated at each node. */
NDLI_API void ndli_rod_rest_changed(ndl_rod *rod);
NDLI_API int ndli_rod_static_options_valid(const ndl_rod_static_options *options);
/* Copies the state to what readings return. */
NDLI_API void ndli_rod_publish(ndl_rod *rod);
/* Copies of the state for undo, one deep: positions, motion, frames. */
NDLI_API void ndli_rod_save(ndl_rod *rod);
NDLI_API void ndli_rod_restore(ndl_rod *rod);

/* ---- rod_step ---- */

/* Minimises the energy over the angles that are not held, nodes where they are and directors as they are. */
NDLI_API void ndli_rod_relax(ndl_rod *rod);
#endif

#endif /* NDL_ROD_STATE_H */

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

/* ---- shape ---- */

static int ndli_rod_set_edge(const ndl_rod *rod, int j, const ndli_v3 *x, const double *theta)
{
    const ndli_rod_shape *shape = &rod->shape;
    ndli_v3 e = ndli_sub(x[j + 1], x[j]), d, across;
    double length = ndli_norm(e), s, c;
    if (!(length > 1e-3 * rod->rest_length[j]) || !ndli_is_finite(length))
        return 0;
    shape->length[j] = length;
    shape->tangent[j] = ndli_scale(1 / length, e);
    if (!(1 + ndli_dot(rod->tangent[j], shape->tangent[j]) > ndli_rod_least_chi))
        return 0;
    d = ndli_rod_transport(rod->tangent[j], shape->tangent[j], rod->director[j]);
    across = ndli_cross(shape->tangent[j], d);
    sbi_dense_sin_cos(theta[j], &s, &c);
    shape->director[j] = d;
    shape->m1[j] = ndli_madd(ndli_scale(c, d), s, across);
    shape->m2[j] = ndli_madd(ndli_scale(-s, d), c, across);
    return 1;
}

static int ndli_rod_set_bend(const ndl_rod *rod, int i, const double *theta)
{
    const ndli_rod_shape *shape = &rod->shape;
    ndli_v3 a = shape->tangent[i - 1], b = shape->tangent[i], carried;
    double chi = 1 + ndli_dot(a, b), reference;
    if (!(chi > ndli_rod_least_chi))
        return 0;
    shape->chi[i] = chi;
    shape->binormal[i] = ndli_scale(2 / chi, ndli_cross(a, b));
    carried = ndli_rod_transport(a, b, shape->director[i - 1]);
    reference = sbi_dense_atan2(ndli_dot(ndli_cross(carried, shape->director[i]), b), ndli_dot(carried, shape->director[i]));
    shape->twist[i] = theta[i] - theta[i - 1] + reference;
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

static double ndli_rod_bend_energy(const ndl_rod *rod, int i)
{
    double sum = 0, w[2];
    if (rod->plain)
        return 0.5 * rod->bending[0] / rod->cell[i] * ndli_dot(rod->shape.binormal[i], rod->shape.binormal[i]);
    for (int j = i - 1; j <= i; j++) {
        ndli_rod_material_curvature(rod, i, j, w);
        for (int k = 0; k < 2; k++)
            sum += rod->bending[k] * (w[k] - rod->rest_bend[i][k]) * (w[k] - rod->rest_bend[i][k]);
    }
    return 0.25 * sum / rod->cell[i];
}

NDLI_API ndli_rod_sums ndli_rod_shape_energy(const ndl_rod *rod)
{
    ndli_rod_sums sums = {0, 0, 0, 0};
    double reach = ndli_rod_reach(rod);
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        double strain = rod->shape.length[j] / rod->rest_length[j] - 1, unknown = 2.3e-16 * reach / rod->rest_length[j];
        sums.stretch += 0.5 * rod->stretch * rod->rest_length[j] * strain * strain;
        sums.noise += rod->stretch * rod->rest_length[j] * (fabs(strain) + unknown) * unknown;
    }
    for (int i = 1; i < rod->node_count - 1; i++) {
        sums.bend += ndli_rod_bend_energy(rod, i);
        sums.twist += 0.5 * rod->torsion / rod->cell[i] * rod->shape.twist[i] * rod->shape.twist[i];
    }
    sums.noise += 4.5e-15 * (sums.stretch + sums.bend + sums.twist);
    return sums;
}

/* ---- derivatives ---- */

/* First and second derivatives of the energy at one node in e_i-1, e_i (0, 1) and theta_i-1, theta_i (0, 1). */
typedef struct ndli_rod_local {
    ndli_v3 edge[2];
    double turn[2];
    ndli_m3 edges[2][2];    /* [1][0] is the transpose of [0][1] and not kept */
    ndli_v3 cross[2][2];    /* [edge][theta] */
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
    for (int e = 0; e < 2; e++)
        local->edge[e] = ndli_m_tapply(&bend->d[e], p);
    if (!wanted)
        return;
    ndli_m_add_identity(&q, k);
    ndli_rod_add_gauss_newton(bend, &q, local);
    if (flags & NDLI_ROD_EXACT)
        ndli_rod_add_curvature_hessian(bend, p, local);
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
    ndli_rod_material_curvature(rod, i, j, w);
    for (int k = 0; k < 2; k++) {
        stiff[k] = rod->bending[k] / (2 * rod->cell[i]);
        s[k] = stiff[k] * (w[k] - rod->rest_bend[i][k]);
    }
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
    double rest = rod->rest_length[j], l = rod->shape.length[j], across = 1 - rest / l;
    ndli_v3 g = ndli_scale(rod->stretch * (l / rest - 1), t);
    ndli_m3 h = ndli_m_zero();
    gradient[j] = ndli_sub(gradient[j], g);
    gradient[j + 1] = ndli_add(gradient[j + 1], g);
    if (!matrix)
        return;
    if (!(flags & NDLI_ROD_EXACT) && across < 0)
        across = 0;
    ndli_m_add_identity(&h, rod->stretch / rest * across);
    ndli_m_add_outer(&h, rod->stretch / rest * (1 - across), t, t);
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
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        double k = factor * rod->damping_stretch * rod->stretch / rod->rest_length[j];
        ndli_v3 t = rod->damping_tangent[j];
        ndli_m_add_outer(&matrix->node[j][0], k, t, t);
        ndli_m_add_outer(&matrix->node[j + 1][0], k, t, t);
        ndli_m_add_outer(&matrix->node[j + 1][1], -k, t, t);
    }
    for (int i = 1; i < rod->node_count - 1; i++) {
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
    double r2 = (double)section->radius * (double)section->radius;
    double i2 = (double)section->inner_radius * (double)section->inner_radius, area = ndli_rod_pi * (r2 - i2);
    double bending = 0.25 * (double)section->young * ndli_rod_pi * (r2 * r2 - i2 * i2);
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
    ndli_v3 **vectors[] = {&rod->x, &rod->v, &rod->a, &rod->director, &rod->tangent, &rod->target, &rod->target_velocity,
                           &rod->force, &rod->reaction, &rod->shape.tangent, &rod->shape.director, &rod->shape.m1,
                           &rod->shape.m2, &rod->shape.binormal, &rod->gradient, &rod->try_x, &rod->try_v, &rod->best_x,
                           &rod->step_x, &rod->predicted, &rod->predicted_velocity, &rod->damping_tangent};
    double **reals[] = {&rod->theta, &rod->rest_length, &rod->mass, &rod->cell, &rod->turn, &rod->torque,
                        &rod->reaction_torque, &rod->shape.length, &rod->shape.chi, &rod->shape.twist,
                        &rod->matrix.turn, &rod->matrix.turn_before, &rod->turn_gradient, &rod->try_theta,
                        &rod->best_theta, &rod->step_theta, &rod->saved_turns};
    ndli_m3 **matrices[] = {&rod->damping_before, &rod->damping_after, &rod->damping_weight};
    for (size_t i = 0; i < sizeof vectors / sizeof *vectors; i++)
        *vectors[i] = (ndli_v3 *)sbi_arena_take(arena, n, v);
    for (size_t i = 0; i < sizeof reals / sizeof *reals; i++)
        *reals[i] = (double *)sbi_arena_take(arena, n, d);
    for (size_t i = 0; i < sizeof matrices / sizeof *matrices; i++)
        *matrices[i] = (ndli_m3 *)sbi_arena_take(arena, n, m);
    rod->rest_bend = (double (*)[2])sbi_arena_take(arena, n, 2 * d);
    rod->matrix.node = (ndli_m3 (*)[3])sbi_arena_take(arena, n, 3 * m);
    rod->matrix.cross = (ndli_v3 (*)[4])sbi_arena_take(arena, n, 4 * v);
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

/* v with its part along the unit vector t taken out, of length 1; any such vector where nothing is left of v. */
static ndli_v3 ndli_rod_across(ndli_v3 v, ndli_v3 t)
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

/* Integrated curvature 2 tan(k h/2) of an arc, at node i. */
static sb_result ndli_rod_set_rest_curvature(ndl_rod *rod, int i, const sb_real *given, sb_error *error)
{
    double k0 = (double)given[0], k1 = (double)given[1], k = sqrt(k0 * k0 + k1 * k1), s, c, factor;
    if (!(k * rod->cell[i] < 2.9))
        return sbi_fail_node(error, SB_ERROR_ARGUMENT, i, "the rest curvature of node %d turns the rod back", i);
    sbi_dense_sin_cos(0.5 * k * rod->cell[i], &s, &c);
    factor = k > 0 ? 2 * s / (c * k) : 0;
    rod->rest_bend[i][0] = factor * k0;
    rod->rest_bend[i][1] = factor * k1;
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
    reals[0] = rod->theta, reals[1] = rod->reaction_torque;
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
static int ndli_rod_has_edge(const ndl_rod *rod, int edge) { return edge >= 0 && edge < rod->node_count - 1; }

/* Where a new support or load begins the energy may become another. */
static void ndli_rod_touched(ndl_rod *rod) { rod->ledger_open = 0; }

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
    double *edge_reals[5];
    node_vectors[0] = rod->x, node_vectors[1] = rod->v, node_vectors[2] = rod->a, node_vectors[3] = rod->target;
    node_vectors[4] = rod->target_velocity, node_vectors[5] = rod->force;
    edge_vectors[0] = rod->director, edge_vectors[1] = rod->tangent;
    edge_reals[0] = rod->theta, edge_reals[1] = rod->rest_length, edge_reals[2] = rod->turn;
    edge_reals[3] = rod->torque, edge_reals[4] = rod->reaction_torque;
    for (int k = 0; k < 6; k++)
        ndli_rod_shift(node_vectors[k], sizeof(ndli_v3), node, n, open);
    ndli_rod_shift(rod->reaction, sizeof(ndli_v3), node, n, open);
    ndli_rod_shift(rod->rest_bend, sizeof *rod->rest_bend, node, n, open);
    ndli_rod_shift(rod->held, 1, node, n, open);
    ndli_rod_shift(rod->has_velocity, 1, node, n, open);
    for (int k = 0; k < 2; k++)
        ndli_rod_shift(edge_vectors[k], sizeof(ndli_v3), edge, n - 1, open);
    for (int k = 0; k < 5; k++)
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
    double after, length, turn;
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
    ndli_rod_share(rod, node, after);
    rod->theta[node - 1] += rod->turn_held[node - 1] ? 0 : turn;
    rod->rest_length[node] = length;
    rod->turn_held[node] |= rod->turn_held[node - 1];
    rod->turn[node] += rod->turn[node - 1];
    rod->torque[node] += rod->torque[node - 1];
    rod->theta[node] = rod->theta[node - 1];
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
    ndli_rod_touched(rod);
    return SB_OK;
}

/* ---- readings ---- */

NDL_API int ndl_rod_node_count(const ndl_rod *rod) { return rod->node_count; }
NDL_API const sb_vec3 *ndl_rod_positions(const ndl_rod *rod) { return rod->public_x; }
NDL_API const sb_vec3 *ndl_rod_velocities(const ndl_rod *rod) { return rod->public_v; }
NDL_API const sb_vec3 *ndl_rod_reactions(const ndl_rod *rod) { return rod->public_reaction; }
NDL_API sb_real ndl_rod_mass(const ndl_rod *rod, int node) { return (sb_real)rod->mass[node]; }
NDL_API sb_real ndl_rod_rest_length(const ndl_rod *rod, int edge) { return (sb_real)rod->rest_length[edge]; }
NDL_API sb_real ndl_rod_reaction_torque(const ndl_rod *rod, int edge) { return (sb_real)rod->reaction_torque[edge]; }

NDL_API ndl_frame ndl_rod_frame(const ndl_rod *rod, int edge)
{
    ndl_frame frame;
    ndli_v3 t = rod->tangent[edge], d = rod->director[edge], across = ndli_cross(t, d);
    double s, c;
    sbi_dense_sin_cos(rod->theta[edge], &s, &c);
    frame.m1 = ndli_to(ndli_madd(ndli_scale(c, d), s, across));
    frame.m2 = ndli_to(ndli_madd(ndli_scale(-s, d), c, across));
    frame.t = ndli_to(t);
    return frame;
}

NDL_API void ndl_rod_tip(const ndl_rod *rod, sb_vec3 *position, ndl_frame *frame)
{
    if (position)
        *position = rod->public_x[rod->node_count - 1];
    if (frame)
        *frame = ndl_rod_frame(rod, rod->node_count - 2);
}

NDL_API void ndl_rod_curvature(const ndl_rod *rod, int node, sb_real curvature[2])
{
    double w[2];
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    w[0] = ndli_dot(rod->shape.binormal[node], ndli_add(rod->shape.m2[node - 1], rod->shape.m2[node]));
    w[1] = -ndli_dot(rod->shape.binormal[node], ndli_add(rod->shape.m1[node - 1], rod->shape.m1[node]));
    for (int k = 0; k < 2; k++)
        curvature[k] = (sb_real)(0.5 * w[k] / rod->cell[node]);
}

NDL_API sb_real ndl_rod_twist(const ndl_rod *rod, int node) { return (sb_real)(rod->theta[node] - rod->theta[node - 1]); }

NDL_API ndl_rod_energy ndl_rod_energies(const ndl_rod *rod)
{
    ndl_rod_energy energy;
    ndli_rod_sums sums;
    double kinetic = 0;
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    sums = ndli_rod_shape_energy(rod);
    for (int i = 0; i < rod->node_count; i++)
        kinetic += 0.5 * rod->mass[i] * ndli_dot(rod->v[i], rod->v[i]);
    energy.stretch = (sb_real)sums.stretch;
    energy.bend = (sb_real)sums.bend;
    energy.twist = (sb_real)sums.twist;
    energy.kinetic = (sb_real)kinetic;
    return energy;
}

NDL_API void ndl_rod_forces(ndl_rod *rod, sb_vec3 *forces)
{
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    ndli_rod_derivatives(rod, 0, rod->gradient, rod->turn_gradient, NULL);
    ndli_rod_set_damping_shape(rod);
    ndli_rod_add_damping_force(rod, rod->v, rod->gradient);
    for (int i = 0; i < rod->node_count; i++)
        forces[i] = ndli_to(ndli_scale(-1, rod->gradient[i]));
}

NDL_API void ndl_rod_base_wrench(const ndl_rod *rod, sb_vec3 *force, sb_vec3 *torque)
{
    ndli_v3 moment = ndli_cross(ndli_sub(rod->x[1], rod->x[0]), rod->reaction[1]);
    if (force)
        *force = ndli_to(ndli_add(rod->reaction[0], rod->reaction[1]));
    if (torque)
        *torque = ndli_to(ndli_madd(moment, rod->reaction_torque[0], rod->tangent[0]));
}

/* ==== src/needle/rod_step.c ==== */
/* rod_step: minimises a rod's potential over nodes and frames: a time step, a static solve, frames alone.
 *
 * Positions x' of a step minimise
 *     1/2 inertia |x' - predicted|^2_M + E(x', theta') - loads.(x' - x) - torques.theta' + dissipation
 * with inertia = 1/(beta dt^2); without inertia and dissipation that is the static potential. */

typedef struct ndli_rod_problem {
    double inertia;   /* 1/s^2: d a'/d x'; 0: statics */
    double rate;      /* 1/s: d v'/d x' */
    int max_newton;
    double tolerance;
} ndli_rod_problem;

/* A state of the minimisation. */
typedef struct ndli_rod_progress {
    double potential, noise; /* J */
    double residual, scale;  /* N: largest of what is left, of what is at work */
    double floor;            /* N: what rounding of positions leaves */
} ndli_rod_progress;

/* ---- frames alone ---- */

static double ndli_rod_turn_potential(const ndl_rod *rod, const double *theta, double *noise)
{
    ndli_rod_sums sums;
    double potential;
    ndli_rod_set_shape(rod, rod->x, theta);
    sums = ndli_rod_shape_energy(rod);
    potential = sums.bend + sums.twist; /* stretching does not change, and would drown it */
    *noise = 4.5e-15 * potential;
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        potential -= rod->torque[j] * theta[j];
        *noise += 4.5e-15 * fabs(rod->torque[j] * theta[j]);
    }
    return potential;
}

static int ndli_rod_any_turn_held(const ndl_rod *rod)
{
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        if (rod->turn_held[j])
            return 1;
    return 0;
}

/* Whether theta_j is no unknown. Nothing tells how a plain rod is turned that is held nowhere: its first edge stays. */
static int ndli_rod_turn_known(const ndl_rod *rod, int j, int any_held)
{
    return rod->turn_held[j] || (j == 0 && !any_held && rod->plain);
}

/* Torque per radian that is little beside twist, and keeps turns determined that no energy sees. */
static double ndli_rod_turn_floor(const ndl_rod *rod, int j) { return 1e-9 * rod->torsion / rod->rest_length[j]; }

/* step_theta = a Newton step for the angles; 0 when the matrix is not positive definite. */
static int ndli_rod_turn_step(ndl_rod *rod, int flags)
{
    int n = ndli_rod_edges(rod), any_held = ndli_rod_any_turn_held(rod);
    ndli_rod_derivatives(rod, flags, rod->gradient, rod->turn_gradient, &rod->matrix);
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

NDLI_API void ndli_rod_relax(ndl_rod *rod)
{
    size_t bytes = (size_t)ndli_rod_edges(rod) * sizeof(double);
    double noise, potential = ndli_rod_turn_potential(rod, rod->theta, &noise);
    for (int iteration = 0; iteration < 50; iteration++) {
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
        if (largest < 1e-13)
            break;
    }
    ndli_rod_set_shape(rod, rod->x, rod->theta);
}

/* ---- potential of a step or solve, and its derivatives, in the shape that is tried ---- */

static ndli_v3 ndli_rod_load(const ndl_rod *rod, int i) { return ndli_madd(rod->force[i], rod->mass[i], rod->gravity); }

static void ndli_rod_try_velocities(ndl_rod *rod, const ndli_rod_problem *problem)
{
    for (int i = 0; i < rod->node_count; i++)
        if (!rod->held[i])
            rod->try_v[i] = ndli_madd(rod->predicted_velocity[i], problem->rate,
                                      ndli_sub(rod->try_x[i], rod->predicted[i]));
}

/* Of rod->shape, made from try_x and try_theta; damping as of the last ndli_rod_set_damping_shape. Spoils gradient. */
static ndli_rod_progress ndli_rod_potential(ndl_rod *rod, const ndli_rod_problem *problem)
{
    ndli_rod_sums sums = ndli_rod_shape_energy(rod);
    ndli_rod_progress progress = {0, 0, 0, 0, 0};
    double sizes = 0;
    progress.potential = sums.stretch + sums.bend + sums.twist;
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
    if (problem->rate > 0) {
        double lost;
        ndli_rod_try_velocities(rod, problem);
        lost = 0.5 / problem->rate * ndli_rod_add_damping_force(rod, rod->try_v, rod->gradient);
        progress.potential += lost;
        sizes += lost;
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
    double rounding = 4.5e-16 * rod->stretch * ndli_rod_reach(rod);
    ndli_rod_derivatives(rod, flags, rod->gradient, rod->turn_gradient, matrix);
    progress->residual = progress->scale = progress->floor = 0;
    if (problem->rate > 0) {
        ndli_rod_set_damping_shape(rod);
        ndli_rod_try_velocities(rod, problem);
        ndli_rod_add_damping_force(rod, rod->try_v, rod->gradient);
    }
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
        for (int other = sbi_max_int(0, row - NDLI_ROD_WIDTH); other <= sbi_min_int(n - 1, row + NDLI_ROD_WIDTH); other++)
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
    if (problem->rate > 0)
        ndli_rod_add_damping_matrix(rod, problem->rate, &rod->matrix);
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

/* One iteration from try_x, try_theta, which rod->shape is made from, by the first of these whose matrix is positive
 * definite and whose step leads down: exact Hessian, Gauss-Newton, the same with a larger diagonal. 0: there is no way
 * down; all is as before. */
static int ndli_rod_iterate(ndl_rod *rod, const ndli_rod_problem *problem, ndli_rod_progress *progress)
{
    static const double shifts[4] = {0, 0, 1e-10, 1e-5};
    int moving = ndli_rod_supports_move(rod);
    size_t n = (size_t)rod->node_count;
    memcpy(rod->best_x, rod->try_x, n * sizeof *rod->best_x);
    memcpy(rod->best_theta, rod->try_theta, n * sizeof *rod->best_theta);
    for (int attempt = problem->max_newton == 1; attempt < 4; attempt++) {
        ndli_rod_progress again;
        if (attempt > 0) {
            memcpy(rod->try_x, rod->best_x, n * sizeof *rod->best_x);
            memcpy(rod->try_theta, rod->best_theta, n * sizeof *rod->best_theta);
            ndli_rod_set_shape(rod, rod->try_x, rod->try_theta);
        }
        ndli_rod_balance(rod, problem, attempt == 0 ? NDLI_ROD_EXACT : 0, &rod->matrix, &again);
        if (ndli_rod_solve_step(rod, problem, shifts[attempt])) {
            double slope = ndli_rod_slope(rod);
            if ((moving || slope < 0) && ndli_rod_search(rod, problem, moving, slope, progress))
                return 1;
        }
    }
    memcpy(rod->try_x, rod->best_x, n * sizeof *rod->best_x);
    memcpy(rod->try_theta, rod->best_theta, n * sizeof *rod->best_theta);
    ndli_rod_set_shape(rod, rod->try_x, rod->try_theta);
    return 0;
}

/* From try_x and try_theta to where the potential is least; predicted says where held nodes go. SB_OK also when capped. */
static sb_result ndli_rod_minimise(ndl_rod *rod, const ndli_rod_problem *problem, ndl_rod_info *info)
{
    ndli_rod_progress progress;
    if (ndli_rod_set_shape(rod, rod->try_x, rod->try_theta) >= 0)
        return SB_ERROR_DIVERGED;
    ndli_rod_set_damping_shape(rod);
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
        progress.potential = ndli_rod_potential(rod, problem).potential; /* with the damping of here */
        if (!ndli_rod_iterate(rod, problem, &progress))
            return now.residual <= 1e3 * now.floor ? SB_OK : SB_ERROR_DIVERGED;
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
static void ndli_rod_read_reactions(ndl_rod *rod, int moving)
{
    ndli_rod_derivatives(rod, 0, rod->gradient, rod->turn_gradient, NULL);
    ndli_rod_set_damping_shape(rod);
    if (moving)
        ndli_rod_add_damping_force(rod, rod->v, rod->gradient);
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
    energy = sums.stretch + sums.bend + sums.twist;
    for (int i = 0; i < rod->node_count; i++)
        energy += 0.5 * rod->mass[i] * ndli_dot(rod->v[i], rod->v[i]);
    *lively = energy;
    for (int i = 0; i < rod->node_count; i++)
        energy -= ndli_dot(ndli_rod_load(rod, i), rod->x[i]);
    return energy;
}

/* Newmark with beta = 1/4, gamma = 1/2; or implicit Euler, which is beta = gamma = 1 without the old acceleration. */
static sb_result ndli_rod_try_step(ndl_rod *rod, double dt, int euler, ndl_rod_info *info)
{
    double beta = euler ? 1 : 0.25, gamma = euler ? 1 : 0.5, keep = euler ? 0 : 1;
    ndli_rod_problem problem;
    sb_result result;
    problem.inertia = 1 / (beta * dt * dt);
    problem.rate = gamma / (beta * dt);
    problem.max_newton = rod->max_newton;
    problem.tolerance = rod->tolerance;
    for (int i = 0; i < rod->node_count; i++) {
        ndli_v3 to = ndli_madd(rod->x[i], dt, rod->v[i]), target = rod->target[i];
        rod->predicted[i] = rod->held[i] ? target : ndli_madd(to, keep * dt * dt * (0.5 - beta), rod->a[i]);
        rod->predicted_velocity[i] = ndli_madd(rod->v[i], keep * dt * (1 - gamma), rod->a[i]);
        rod->try_v[i] = rod->has_velocity[i] ? rod->target_velocity[i]
                                             : ndli_scale(1 / dt, ndli_sub(target, rod->x[i]));
        rod->try_x[i] = rod->x[i];
    }
    ndli_rod_set_turns(rod, 1);
    result = ndli_rod_minimise(rod, &problem, info);
    if (result != SB_OK)
        return result;
    ndli_rod_try_velocities(rod, &problem);
    for (int i = 0; i < rod->node_count; i++) {
        if (rod->held[i])
            rod->a[i] = ndli_scale(1 / dt, ndli_sub(rod->try_v[i], rod->v[i]));
        else
            rod->a[i] = ndli_scale(problem.inertia, ndli_sub(rod->try_x[i], rod->predicted[i]));
        rod->v[i] = rod->try_v[i];
        rod->x[i] = rod->try_x[i];
        if (!ndli_is_finite(ndli_norm(rod->a[i])))
            return SB_ERROR_DIVERGED;
    }
    memcpy(rod->theta, rod->try_theta, (size_t)ndli_rod_edges(rod) * sizeof *rod->theta);
    return ndli_rod_moved(rod) < 0 ? SB_OK : SB_ERROR_DIVERGED;
}

/* Whether the step has energy that came from nowhere. */
static int ndli_rod_gained(ndl_rod *rod)
{
    double lively, energy = ndli_rod_total_energy(rod, &lively);
    return energy - rod->ledger > 0.01 * lively;
}

/* Opens or closes the ledger; 1 when it may be held against the step. */
static int ndli_rod_keep_ledger(ndl_rod *rod)
{
    double lively;
    int busy = ndli_rod_any_torque(rod) || rod->base_director_set;
    for (int i = 0; i < rod->node_count; i++)
        busy = busy || rod->turn[i] != 0 ||
               (rod->held[i] && (rod->has_velocity[i] || ndli_norm(ndli_sub(rod->target[i], rod->x[i])) > 0));
    if (busy) {
        rod->ledger_open = 0;
    } else if (!rod->ledger_open) {
        rod->ledger = ndli_rod_total_energy(rod, &lively);
        rod->ledger_open = 1;
    }
    return !busy;
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
    watched = ndli_rod_keep_ledger(rod);
    ndli_rod_save(rod);
    result = ndli_rod_try_step(rod, (double)dt, 0, info);
    if (watched && (result != SB_OK || ndli_rod_gained(rod))) {
        ndli_rod_restore(rod);
        info->damped = 1;
        result = ndli_rod_try_step(rod, (double)dt, 1, info);
    }
    if (result != SB_OK) {
        ndli_rod_restore(rod);
        return ndli_rod_fail(info, result, "Newton found no step that lowers the potential; the step was undone");
    }
    ndli_rod_clear_turns(rod);
    ndli_rod_read_reactions(rod, 1);
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
        rod->predicted_velocity[i] = ndli_v(0, 0, 0);
        if (rod->held[i])
            rod->predicted[i] = share < 1 ? ndli_madd(rod->x[i], share, ndli_sub(rod->target[i], rod->x[i]))
                                          : rod->target[i];
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
    return ndli_rod_moved(rod) < 0 ? SB_OK : SB_ERROR_DIVERGED;
}

static sb_result ndli_rod_solve_pieces(ndl_rod *rod, const ndl_rod_static_options *options, ndl_rod_info *info)
{
    ndli_rod_problem problem = {0, 0, 20, 0.01};
    int pieces = ndli_rod_pieces(rod), most = options->max_newton;
    sb_result result = SB_OK;
    for (int piece = 0; piece < pieces - 1 && result == SB_OK; piece++)
        result = ndli_rod_solve_piece(rod, &problem, 1.0 / (pieces - piece), info);
    problem.tolerance = (double)options->tolerance;
    for (int done = 0; result == SB_OK && done < most; done += problem.max_newton) {
        /* frames are told from where the last round ended: none may turn far between two */
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
        return ndli_rod_fail(info, result, result == SB_ERROR_NOT_CONVERGED
                                               ? "max_newton was reached; the rod is as it was"
                                               : "Newton found no step that lowers the energy; the rod is as it was");
    }
    memset(rod->v, 0, n * sizeof *rod->v);
    memset(rod->a, 0, n * sizeof *rod->a);
    ndli_rod_clear_turns(rod);
    ndli_rod_read_reactions(rod, 0);
    rod->ledger_open = 0;
    ndli_rod_publish(rod);
    info->error.element = info->error.node = -1;
    return SB_OK;
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
