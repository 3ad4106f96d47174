/* rigid: rigid bodies with mass that nodes hang on and that move freely: bones, ribs, floating plates, clamps, bolts,
 * tables on springs. Floor 3. One that goes by a pose of your own is sb_body_place_rigid.
 *
 * ```c fragment
 * sb_rigid_def rib = sb_default_rigid_def();
 * sb_rigid_motion motion;
 * int id, ends[9] = {4, 9, 14, 19, 24, 29, 34, 39, 44};
 * rib.mass = (sb_real)0.05;
 * rib.inertia = sb_m3_scale((sb_real)1e-5, sb_m3_identity());
 * rib.centre = sb_v3((sb_real)0.42, (sb_real)0.05, (sb_real)0.05);
 * rib.nodes = ends;
 * rib.node_count = 9;
 * if (sb_body_add_rigid(body, &rib, &id, &error) != SB_OK)
 *     return 1;
 * sb_body_set_rigid_load(body, id, sb_v3(0, 0, (sb_real)-0.1), sb_v3(0, 0, 0));
 * for (int i = 0; i < 60; i++)
 *     if (sb_body_step(body, dt, NULL) != SB_OK)
 *         return 1;
 * sb_body_rigid_motion(body, id, &motion);
 * printf("the rib has turned to w = %g, and feels %g N\n", (double)motion.turn.w, (double)motion.force.z);
 * ```
 *
 * A node i that hangs on it is at x_i = c + R X_i, c the centre of mass, R its turn and X_i where the node was when the
 * rigid body was added. So its motion is none of the unknowns: dx_i = T_i (dc, dth), T_i = [1, -[R X_i]x], and the six
 * unknowns of the rigid body are solved together with the nodes that are free, by
 *     sum_i T_i^T r_i + (m (a - g) - f, R (J w' + w x J w) - t) = 0
 * with r_i what the tissue's forces, inertia and loads leave over at node i, J the inertia and w the angular velocity
 * in its own frame, f and t its load, g the body's gravity. This is exact: no spring holds the nodes, and none has to
 * be chosen. Turns are finite (the exponential map, quaternions), of up to half a turn in a step. Conjugate gradients
 * work on the free nodes, with a block of 6 x 6 for each rigid body, which is factored in each iteration of Newton; the
 * solve goes on with rows of where they have come to until turns are what the rows say to 1e-10. What the turning of
 * the arms R X_i adds to the stiffness (it may be indefinite) is left out: Newton finds the same balance, a step of
 * one linear solve (max_newton 1) has its arms where they end. A slab of 121 of 3,025 nodes in the middle of a soft
 * beam takes 12 iterations a step where it is heavy and 20 where it weighs next to nothing, for 7 where it is held.
 *
 * In time c and R go by the body's own scheme: implicit Euler keeps the angular momentum of a rigid body that nothing
 * acts on, and errs by the first order of |w| dt; Newmark and generalised alpha are of second order, momentum of turns
 * included (Bruels and Cardona 2010 with the coefficients of the scheme). A top that spins by 10 rad in 400 steps, and
 * precesses, is then 0.015 rad off with Euler, 2e-5 and 3e-5 with the others. Linear momentum is kept as without rigid
 * bodies: nodes' own mass moves with them. Damping of the body does not act on the rigid body's own mass. A body that
 * only such nodes hold turns freely about a single one of them: steps long enough for statics then say
 * SB_ERROR_INDEFINITE.
 *
 * A static solve finds where they and the tissue are in balance, from where they are, at rest then: with their loads
 * and weights, which its increments raise from those of the static solve before as they do nodes' loads; each increment
 * turns by up to half a turn. What their arms' turning adds to the stiffness is in its tangent. A torque keeps its
 * direction, and so has no potential: what is antisymmetric in how it balances is found by some more solves in each
 * iteration. One that bends what hangs by half a turn or more has no balance that such a tangent tells
 * (SB_ERROR_NOT_CONVERGED); one that twists may go further. Rigid bodies hold parts of the mesh to each other; what can
 * move freely all the same is refused: SB_ERROR_UNCONSTRAINED, with the node or the rigid body. Measured: a beam whose
 * outer fifth is rigid is within 0.11 % of Timoshenko's, its wrench that of the load to 1e-9; bent by a torque into an
 * arc of 1.25 rad in one increment of 17 iterations.
 *
 * Modes have their six unknowns, with their masses.
 *
 * SB_CENTRAL_DIFFERENCE has no free rigid bodies; derivatives, searches for a shape without loads and
 * registrations refuse a body that has one (SB_ERROR_UNSUPPORTED). Tools press on
 * what hangs as on all nodes. State and recordings have rigid bodies with all they are; sb_body_reset takes them back
 * to where they were added, at rest. A change of the mesh: a node made of nodes that all hang on the same rigid body
 * hangs on it as well (a copy where its piece keeps a face that hangs); one that hangs and has no heir cannot be
 * removed (SB_ERROR_ARGUMENT, by name), one that is moved hangs where it comes to; what is ablated hangs no longer. A
 * needle cannot hold a node that hangs (SB_ERROR_INDEX from its step). sb_energy is that of the tissue alone.
 *
 * Sources: Simo and Vu-Quoc 1988 (rotations of finite size in Newmark's scheme), Bruels and Cardona 2010; Gould, Hribar
 * and Nocedal 2001 (conjugate gradients in the null space of equations). */
#ifndef SB_RIGID_H
#define SB_RIGID_H

#include "body.h"

/* What sb_body_add_rigid takes. Start from sb_default_rigid_def(). */
typedef struct sb_rigid_def {
    sb_real mass; /* kg, > 0 */
    sb_mat3
        inertia; /* kg m^2, about the centre of mass, along the axes of its own frame: symmetric, positive definite */
    sb_vec3 centre;   /* m, in space: where its centre of mass is now */
    sb_quat turn;     /* from its own frame to space now; taken at unit length. Default: none */
    sb_vec3 velocity; /* m/s, of the centre of mass; default 0 */
    sb_vec3 spin;     /* rad/s, its angular velocity in space; default 0 */
    const int *nodes; /* [node_count] nodes that hang on it, each once, as they are now; they get its velocity */
    int node_count;   /* >= 0 */
} sb_rigid_def;
/* mass 0 and inertia 0, to be set; turn the identity, the rest 0. */
SB_API sb_rigid_def sb_default_rigid_def(void);

/* How a rigid body moves, at the end of the last step; and in it: */
typedef struct sb_rigid_motion {
    sb_vec3 centre;   /* m */
    sb_quat turn;     /* unit quaternion, from its own frame to space */
    sb_vec3 velocity; /* m/s */
    sb_vec3 spin;     /* rad/s, in space */
    sb_vec3 force;    /* N, of the tissue on it, with the nodes' inertia and all that acts on them (gravity, loads,
                       * tools): where sb_body_reactions has its balance. In balance it is the opposite of its load */
    sb_vec3 torque;   /* N m, the same about its centre; about q it is torque + (centre - q) x force */
} sb_rigid_motion;

enum { SB_MAX_RIGID = 96 }; /* free rigid bodies of one sb_body */

/* Adds a rigid body that moves freely; *id (may be NULL) is its number, never used again by this body. The def is
 * copied; allocates, so that steps do not. Errors, with nothing added: SB_ERROR_ARGUMENT (NULL; a mass, an inertia or a
 * turn that is none; a node that is supported, in no element, the slave of a constraint, twice in the list or on
 * another rigid body: error->node), SB_ERROR_INDEX (error->node), SB_ERROR_NOT_FINITE, SB_ERROR_UNSUPPORTED (explicit
 * steps; more than SB_MAX_RIGID), SB_ERROR_MEMORY. Nodes that hang can neither be supported nor become slaves of
 * constraints (SB_ERROR_ARGUMENT); they may be masters. */
SB_API sb_result sb_body_add_rigid(sb_body *body, const sb_rigid_def *def, int *id, sb_error *error);
/* What acts on it besides tissue and gravity, from the next step on until it is set again: a force (N) at its centre of
 * mass and a torque (N m), both in space. Allocates nothing. SB_ERROR_ARGUMENT, SB_ERROR_INDEX (no such rigid body),
 * SB_ERROR_NOT_FINITE. */
SB_API sb_result sb_body_set_rigid_load(sb_body *body, int id, sb_vec3 force, sb_vec3 torque);
/* SB_ERROR_ARGUMENT, SB_ERROR_INDEX leave *motion untouched. */
SB_API sb_result sb_body_rigid_motion(const sb_body *body, int id, sb_rigid_motion *motion);
/* Takes it away; its nodes go on as they move. SB_ERROR_ARGUMENT, SB_ERROR_INDEX. */
SB_API sb_result sb_body_remove_rigid(sb_body *body, int id);
SB_API int sb_body_rigid_count(const sb_body *body);

#endif /* SB_RIGID_H */
