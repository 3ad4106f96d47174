/* contact: tools that push, slide on and grip a body, and the forces that they feel. Floor 4.
 *
 * ```c fragment
 * sb_contact_def def = sb_default_contact_def();
 * sb_tool_def tool = sb_default_tool_def();
 * sb_contact *contact;
 * int probe;
 * def.body = body;
 * tool.radius = (sb_real)0.02;
 * tool.pose.position = sb_v3((sb_real)0.2, (sb_real)0.05, (sb_real)0.121);
 * if (sb_contact_create(&def, &contact, &error) == SB_OK &&
 *     sb_contact_add_tool(contact, &tool, &probe, &error) == SB_OK) {
 *     sb_wrench wrench; // each frame:
 *     tool.pose.position.z -= (sb_real)1e-4;
 *     sb_contact_move_tool(contact, probe, &tool.pose);
 *     sb_body_step(body, dt, NULL);
 *     sb_contact_wrench(contact, probe, &wrench);
 *     sb_contact_destroy(contact);
 * }
 * ```
 *
 * Steps and static solves of the body do contact by themselves. The surface of the body feels a pressure p = max(0, l -
 * k g) where it overlaps a tool (gap g < 0), on samples so close that forces are smooth while it slides; k is
 * `stiffness` times the local stiffness of the step's own matrix, so that modulus, size, mass and dt need no tuning; l
 * remembers the pressure of the step before, so that the overlap vanishes where the surface rests. Friction is
 * Coulomb's, anchored: what sticks does not creep. All is solved within the implicit step; the preconditioner is made
 * once.
 *
 * Tools cannot pass through: each moves freely up to the surface, and there by half of its inner radius in a step at
 * most, less the deeper it lies. What it could not make is its lag, made up in the steps to come. A step after which
 * something may have passed is taken back and done again with half the tools' way, then with tools that stay, then with
 * tools that give way to what presses on them; where the tissue itself flies it is divided into up to 16
 * steps (sb_step_info.substeps): what is refused is tried half as long, down to a sixteenth, and readings are those of
 * the last. Only then is it refused: SB_ERROR_DIVERGED, and all is
 * as it was.
 *
 * A tool with coupling_stiffness hangs by a spring on the pose that it is sent to, and is where spring and surface
 * balance at the end of each step, whatever the ratio of their stiffness: both are solved together. Its lag is what the
 * spring is stretched by.
 *
 * With `pairs` organs touch each other, and themselves where they are folded: an organ is a part of the mesh that
 * shares no node with others, so that what is to touch goes into one mesh (sb_mesh_append) and one body; two bodies do
 * not see each other. Forces between them balance to rounding. Faces touch where they look at each other; those of one
 * organ only where their middles are farther apart at rest than two of their lengths, so that a surface that is folded
 * from the start does not, or where they are the two lips of a cut (with `skin`). What would come deeper into an organ
 * than 0.24 of its thickness or of a face's length in a step is held, momentum kept, kinetic energy lost. A step in
 * which a point would yet end deeper in an organ than 0.4 of its thickness or of a face's length, or pass through it,
 * is divided like one with tools, at once into parts as short as the organs' speed asks for. In parts of a sixteenth,
 * what would still pass moves together, as far as it would have on the mean: momentum stays, kinetic energy is lost
 * (sb_contact_info.mended). Overlap that was there without having been pressed in is let out by a fifth a step, so
 * that it throws nothing out. It is not certain yet: of 189 random scenes with rho v^2 up to 2 E points came deeper
 * than half a cell into an organ in 9, from 0.8 E on, up to 0.9 cells; none ended entangled. Of 32 with Newmark or
 * generalised alpha in 2, up to 0.74 cells.
 *
 * With `skin` what is touched is a surface that the body carries along, in place of the boundary of its mesh: one that
 * was embedded in it (sb_skin_create), however coarse the mesh. All is as of the boundary, but: faces are the skin's
 * triangles; sb_contact_pressures has a number for each of its points; and overlap that the mesh is too coarse to give
 * way to stays. Where triangles lie across cells, systems take more iterations. The surface of a body that is cut, lips
 * and all, is such a skin (sb_cut_surface_skin).
 *
 * With `skin` and `pairs` it is the skins of organs that touch, which have to be closed: the connected part of the mesh
 * that a point lies in is its organ. Parts that a cut has parted are organs (SB_CONTACT_ORGANS). The lips of a cut that
 * ends in one organ touch each other from the start (SB_CONTACT_SELF), but for two rings of triangles about its end;
 * walls of what was burnt out do not while they are nearer at rest than two of their lengths. Triangles no longer than
 * the organ's mean have one sample, and where max_contacts is less than all lips together have triangles some of these
 * stand for the others (info.thinned). Contact follows each cut in the next step: pressures and friction of triangles
 * that are still there stay.
 *
 * What contact does not take part in: it is no support, so that a static solve of a body which only tools hold is
 * refused (SB_ERROR_UNCONSTRAINED); registration (register.h) and frequencies do not feel it; and the accelerations
 * that Newmark and generalised alpha find before a body's first step are without it.
 *
 * Friction needs damping in the integrator: implicit Euler, or generalised alpha with a spectral radius of 0.5 or less;
 * Newmark's average acceleration rings where the surface touches.
 *
 * Bodies with explicit steps (SB_CENTRAL_DIFFERENCE) are touched by tools, not by their own organs. Forces act beside
 * the loads, with `stiffness` over the body's own bounded by the nodes' masses; where a tool is near, substeps are
 * shorter by 1.8 sqrt(stiffness / 3), with the default 3.3 times. No pressure is remembered: overlap stays, and takes
 * some tenth of a tool's way. Readings are those of the last substep. Momentum is exact while the mesh stays: a cut
 * through touched faces takes half a substep of their force, and contact there is softer by the smaller masses. Energy
 * is right to a few per cent of a hit, since what first touches within a substep does so at its end.
 * sb_contact_stiffness and hands (sb_haptic) need the system of an implicit step. Source: Wriggers, Computational
 * Contact Mechanics (return mapping, augmented Lagrangian). */
#ifndef SB_CONTACT_H
#define SB_CONTACT_H

#include "../body/skin.h"
#include "../body/step.h"
#include "tool.h"

typedef struct sb_contact sb_contact;

/* What touches what besides tools: organs are parts of the mesh that share no node. */
typedef enum sb_contact_pairs {
    SB_CONTACT_SELF = 1,  /* an organ and itself, where it is folded */
    SB_CONTACT_ORGANS = 2 /* different organs */
} sb_contact_pairs;

/* What a contact is made from. Start from sb_default_contact_def(). */
typedef struct sb_contact_def {
    sb_body *body;      /* borrowed: destroy the contact first; one contact per body */
    sb_real stiffness;  /* of the pressure, over the body's own, >= 3; default 10. More is stiffer and costs iterations;
                         * 3 .. 30 is sensible */
    int max_iterations; /* systems of contact in a linearised step, >= 1; default 4 */
    int max_contacts;   /* samples near tools at a time, and as many of pairs, in [64, 2^20]; default 8192: memory is
                         * taken at creation. Where there are more, faces get fewer samples for that step
                         * (info.thinned) */
    int max_tools;      /* in [1, 64]; default 8 */
    sb_skin *skin; /* what is touched, see above; borrowed: destroy the contact first. NULL (default): the boundary of
                    * the body's mesh */
    int pairs;     /* SB_CONTACT_SELF | SB_CONTACT_ORGANS: what else touches; default 0: tools only */
    sb_real pair_friction;         /* Coulomb's mu between organs, >= 0; default 0 */
    sb_real pair_distance;         /* m that they keep from each other, >= 0; default 0 */
    const sb_allocator *allocator; /* NULL (default): the body's */
    unsigned cookie;               /* set by sb_default_contact_def; a def made without it is refused */
} sb_contact_def;
SB_API sb_contact_def sb_default_contact_def(void);

/* SB_ERROR_ARGUMENT names the field; SB_ERROR_STATE: the body has a contact already; SB_ERROR_UNSUPPORTED: its steps
 * are explicit and def.pairs is not 0, or it is of custom elements and def.skin is given; SB_ERROR_STATE also for a
 * skin that is none of this body's mesh, or does not follow its changes; SB_ERROR_MESH: it has no surface, or def.pairs
 * is not 0 and def.skin (one of sb_skin_create) is open, turned against itself or inside out: error->element is the
 * triangle; SB_ERROR_MEMORY. *contact is then untouched. Nothing allocates afterwards but sb_contact_add_tool. */
SB_API sb_result sb_contact_create(const sb_contact_def *def, sb_contact **contact, sb_error *error);
SB_API void sb_contact_destroy(sb_contact *contact); /* NULL is fine */

/* ---- tools ---- */

/* Makes a tool; *tool is its number, the lowest that is free. What sbi_tool_create refuses; SB_ERROR_ARGUMENT: it
 * overlaps the body by more than half its inner radius (error->element: the cell of the deepest face), or lies inside
 * the body, however small it is and whether or not it touches a face (error->element: the cell of a face near it; of a
 * skin that is open: where lines along all axes of space leave it), or max_tools are there, or the pose takes it too
 * far, see below; SB_ERROR_UNSUPPORTED: so thin that the faces would need too many samples (needle.h is for such). */
SB_API sb_result sb_contact_add_tool(sb_contact *contact, const sb_tool_def *def, int *tool, sb_error *error);
/* In all calls below SB_ERROR_ARGUMENT: no contact, or a point of the tool would be farther than 1e9 m from the origin,
 * or so far that rounding moves it by a hundredth of its radius (of 1 cm in floats: 840 m); SB_ERROR_INDEX: no such
 * tool; SB_ERROR_NOT_FINITE: a number that is none. Nothing changes then. */
SB_API sb_result sb_contact_remove_tool(sb_contact *contact, int tool);
/* Where it is to be at the end of the next step. */
SB_API sb_result sb_contact_move_tool(sb_contact *contact, int tool, const sb_pose *pose);
/* At once, without a way, and with its contacts forgotten. SB_ERROR_ARGUMENT: too deep in the body or inside it, as at
 * creation. */
SB_API sb_result sb_contact_place_tool(sb_contact *contact, int tool, const sb_pose *pose, sb_error *error);
/* Capsules: the chain at the end of the next step, points[as many as the def had] (m, in the tool's frame). */
SB_API sb_result sb_contact_bend_tool(sb_contact *contact, int tool, const sb_vec3 *points);
SB_API sb_result sb_contact_set_friction(sb_contact *contact, int tool, sb_real friction);

/* ---- readings of the last step or static solve: no allocation ---- */

typedef struct sb_wrench {
    sb_vec3 force;  /* N */
    sb_vec3 torque; /* N m about the tool's position */
} sb_wrench;
/* What the body does to the tool: the sum of exactly the forces put on the body's nodes, with the opposite sign. */
SB_API sb_result sb_contact_wrench(const sb_contact *contact, int tool, sb_wrench *on_tool);
/* Where the tool is, and how far a point of it may still be from where it was sent (m). Either place may be NULL. */
SB_API sb_result sb_contact_reached(const sb_contact *contact, int tool, sb_pose *pose, sb_real *lag);

/* k[i][j]: what component i of the wrench (force, then torque about the tool's position, which goes along) would change
 * by if the tool had gone farther along axis j (m), or turned (rad) about axis j - 3 through its position, with the
 * tissue giving way as in the last step: N/m, N, N m. Of a step that was divided (info.substeps) as in its last part:
 * inertia makes tissue stiffer over a shorter time. What slips keeps its bound, and normals their directions. Of a
 * tool on a spring that of the surface alone. Six linear solves to 1e-3, which allocate nothing. 0 where nothing
 * touches. SB_ERROR_STATE: something was done since the last step or static solve (a state loaded, a tool placed), so
 * that its system is gone. */
SB_API sb_result sb_contact_stiffness(sb_contact *contact, int tool, sb_real k[6][6]);
/* What its spring does to a tool with coupling_stiffness; 0 for others. It is the wrench with the opposite sign, to
 * 1e-9, but in a step in which the tool went as far as it may, and for the torque of a tool that turns as it is sent
 * to. */
SB_API sb_result sb_contact_coupling(const sb_contact *contact, int tool, sb_wrench *on_tool);

/* What two jaws hold between them. */
typedef struct sb_grip {
    sb_vec3
        axis; /* unit, from the first jaw's push to the other's: the way the first one presses; 0: nothing is held */
    sb_real force; /* N along the axis that both press with: the lesser of the two */
    sb_vec3 place; /* m: middle of the two tools' positions */
    sb_wrench net; /* what the body does to both together: the load on the grip, its torque about `place` */
    sb_real
        sticking; /* share of the pushes, in [0, 1], at points that friction holds; 0: it slips, or nothing is held */
    sb_real used; /* load across the axis, of the most that friction holds: at 1 it slips out */
} sb_grip;
/* Reads two tools as one grip: any two, whatever holds them. SB_ERROR_INDEX: no such tool, or twice the same. */
SB_API sb_result sb_contact_grip(const sb_contact *contact, int jaw, int other, sb_grip *grip);

typedef struct sb_contact_point {
    int tool;                      /* -1: two organs */
    int element;                   /* cell behind the face; of a skin that of the triangle's first corner */
    int face;                      /* of that cell, in the order of sb_element's faces; of a skin the triangle */
    int other_element, other_face; /* likewise what it touches when that is an organ, else -1 */
    int sticks;                    /* 1: friction holds it; 0: it slips, or there is no friction */
    sb_real gap;                   /* m, negative: overlap */
    sb_real area;                  /* m^2 at rest */
    sb_vec3 point;                 /* m, in space */
    sb_vec3 normal;                /* out of the tool, or of the other organ */
    sb_vec3 force;                 /* N, on the body */
} sb_contact_point;
/* How many there are, the first `capacity` of them in points (NULL with capacity 0). */
SB_API int sb_contact_points(const sb_contact *contact, sb_contact_point *points, int capacity);
/* [node_count], with a skin [its points]: mean pressure (Pa at rest) that tools exert on the surface there: for
 * drawing. 0 elsewhere. */
SB_API sb_result sb_contact_pressures(const sb_contact *contact, sb_real *pressures);

typedef struct sb_contact_info {
    int candidates; /* samples looked at */
    int touching;   /* with pressure */
    int sticking;   /* of these held by friction */
    int iterations; /* systems solved */
    int retries;    /* times that the step was taken back and done again */
    int capped;     /* 1: max_iterations ended the iteration; `residual` says how good it is */
    int thinned;    /* 1: faces had fewer samples than their size asks for */
    int mended; /* 1: organs would have passed through each other, or a tool, in the shortest part of a divided step */
    int inside; /* tools that the body surrounded where the step began, whether or not they touched its surface: it was
                 * put over them (sb_body_set_displacements), for none is made or placed there. They feel what touches
                 * them, if anything does, and are not led out: place them outside */
    sb_real deepest;  /* m, overlap */
    sb_real residual; /* of contact's forces, of the largest force; where nothing holds the body also what their sum is
                       * off by, 2.5 times, of all forces from outside */
    sb_real lag;      /* m, largest of all tools' */
} sb_contact_info;
SB_API sb_contact_info sb_contact_get_info(const sb_contact *contact);

#endif /* SB_CONTACT_H */
