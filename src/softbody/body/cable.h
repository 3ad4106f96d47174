/* cable: ligaments, sutures, threads, tethers and springs of a rest length, between points of bodies and points in
 * space. Floor 3. */
#ifndef SB_CABLE_H
#define SB_CABLE_H

#include "load.h"

/* A cable goes from its first point to the last and slides through those between without friction, like a suture: its
 * tension is the same all along. Two points: a spring or a ligament. Each point is one of three things: a node; a mix
 * of nodes, as a point inside an element is (sb_embedding_mapping); or a place in space, as on a bone, which
 * sb_body_move_cable moves. Points of two organs: put their meshes into one body (sb_mesh_append). */
typedef struct sb_cable_def {
    int count;              /* points, >= 2, of which at least one belongs to the body */
    const int *nodes;       /* [count] node of each point, -1 for those that are none; NULL: all are none */
    const sb_mapping *rows; /* of points that are no nodes: `count` rows of node weights, that of a point in space is
                             * empty or has the single weight 0; NULL: all of them are in space */
    const sb_vec3 *places; /* [count] (m) of points in space; what others have here is not read. NULL: there are none */
    sb_real rest_length;   /* m; 0: as long as it is now */
    sb_real stiffness;     /* N, >= 0: tension per strain, Young's modulus times area */
    sb_real toe_strain;    /* >= 0, strain in which wavy fibres straighten: up to there the tension is that of
                            * stiffness strain^2 / (2 toe_strain), from there on it rises with the whole stiffness */
    int pushes;            /* 0: slack when shorter than rest_length; 1: a rod that resists this in the same way */
} sb_cable_def;

SB_API sb_cable_def sb_default_cable_def(void); /* of its present length, slack when shorter, no toe, stiffness 0 */

/* Adds a cable as one load more, by whose id sb_body_load_force (of what it does to the body) and sb_body_remove_load
 * know it, too. The def and its arrays are copied.
 * - Forces come from the energy stiffness rest_length (e^2/2 - toe e/2 + toe^2/6), e = length / rest_length - 1, past
 * the toe, and stiffness rest_length e^3 / (6 toe) within it; a slack cable has none at all. Statics, and steps of
 *   several Newton iterations, find the balance with it; a linearised step (max_newton 1) takes what it is at the start
 *   and its stiffness there: a cable that goes taut or slack within the step does so in the next one.
 * - The stiffness is positive semidefinite and part of every tangent: a stiff cable is safe at any dt. Under pressure a
 *   rod (pushes) buckles where exact tangents are asked for; others leave that part out.
 * - A static solve goes evenly from the rest length, stiffness and places that the last one ended with to the present
 *   ones, and starts a new cable from no tension. It takes a cable as something that holds its length; where cables
 *   alone hold a body and are slack at first, give it more load steps, or a support.
 * - Explicit steps are bounded by the stiffness of all cables, slack ones too.
 * - When the mesh changes, points go with their nodes and their material as rows of mappings do: to heirs of nodes
 *   that go, to the cell that has their material. Points in space stay.
 * Errors, with nothing added: SB_ERROR_ARGUMENT (NULL; fewer than 2 points; none of the body; a stiffness or toe strain
 * below 0; rest_length below 0, or 0 where all points lie on one place; a point without a place, or whose weights do
 * not sum to 1), SB_ERROR_INDEX (a node out of range, or of no element), SB_ERROR_NOT_FINITE, SB_ERROR_MEMORY;
 * error->element names the point. Points without a common element enlarge the body's tangent as those of a mapping's
 * row do.
 * Source: Blemker and Delp 2005 (paths that slide), Weiss et al. 1996 (toe of ligaments). */
SB_API sb_result sb_body_add_cable(sb_body *body, const sb_cable_def *def, int *load_id, sb_error *error);
/* Changes between steps, without allocation: a suture that is tightened, a ligament that was torn (stiffness 0).
 * SB_ERROR_INDEX: no cable has this id; SB_ERROR_ARGUMENT (rest_length <= 0, stiffness < 0), SB_ERROR_NOT_FINITE. */
SB_API sb_result sb_body_set_cable_rest_length(sb_body *body, int load_id, sb_real rest_length);
SB_API sb_result sb_body_set_cable_stiffness(sb_body *body, int load_id, sb_real stiffness);
/* places[points] (m): those of points in space are taken, others are not read. */
SB_API sb_result sb_body_move_cable(sb_body *body, int load_id, const sb_vec3 *places);

/* Tension (N) in the last step or static solve, 0 before; negative in a rod under pressure, and where a linearised step
 * let a cable go slack. */
SB_API sb_result sb_body_cable_tension(const sb_body *body, int load_id, sb_real *tension);
/* Of its present points: length (m), and points[points] (m). */
SB_API sb_result sb_body_cable_length(const sb_body *body, int load_id, sb_real *length);
SB_API sb_result sb_body_cable_points(const sb_body *body, int load_id, sb_vec3 *points);
/* forces[points] (N) on each point in the last step or static solve; they sum to 0. What a point in space feels is what
 * its bone feels. */
SB_API sb_result sb_body_cable_forces(const sb_body *body, int load_id, sb_vec3 *forces);

#endif /* SB_CABLE_H */
