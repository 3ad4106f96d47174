/* rod: a discrete elastic rod: a needle's stretching, bending and twisting, with or without tissue. Floor 6.
 *
 * A rod is a chain of nodes x_0 (base) ... x_n-1 (tip) and the edges e_j = x_j+1 - x_j between them. Each edge carries
 * a material frame (m1, m2, t): t along the edge, m1 and m2 across it, which says how the rod is turned about its own
 * axis. Twist runs along a rod faster than anything a step resolves, so frames have no inertia: they always minimise
 * the energy (Bergou et al. 2008, "Discrete elastic rods"; 2010 for the frames carried in time). */
#ifndef NDL_ROD_H
#define NDL_ROD_H

#include "api.h"

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
