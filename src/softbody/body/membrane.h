/* membrane: thin elastic sheets on faces of a body: the capsule of an organ, the wall of a vessel. Floor 3. */
#ifndef SB_MEMBRANE_H
#define SB_MEMBRANE_H

#include "load.h"

/* A sheet on outer faces of a body, which moves with their nodes: it resists stretch, not bending. It is incompressible
 * and neo-Hookean, so that it thins as it stretches; Young's modulus is three times its shear modulus. It has no mass
 * of its own and needs the elements that it lies on: for a sheet alone put it on thin, soft ones. */
typedef struct sb_membrane_def {
    const int *faces; /* [face_count][corners] corner nodes of each face, in any order; NULL: all outer faces */
    int face_count;
    int corners;        /* 3: faces of tets, 4: of hexahedra */
    sb_real thickness;  /* m, > 0, at rest */
    sb_real shear;      /* Pa, >= 0: shear modulus */
    sb_real prestretch; /* > 0: how far the rest shape of the body stretches the sheet, in all directions; 1: not */
    int wrinkles;       /* 1: it folds instead of being pressed together, and pulls in no direction that got shorter; 0:
                         * it resists this as it resists stretch */
} sb_membrane_def;

/* corners 3, prestretch 1, it wrinkles; no faces, thickness and shear 0. */
SB_API sb_membrane_def sb_default_membrane_def(void);

/* Adds a membrane as one load more, by whose id sb_body_load_force (which is 0) and sb_body_remove_load know it, too.
 * The def and its faces are copied; a face twice has two sheets.
 * - Forces come from the energy thickness shear / 2 (tr C + 1 / det C - 3) per area of the sheet, C = F^T F in its
 *   plane. One that wrinkles has Pipkin's relaxed energy: with stretches a >= b, where b < a^-1/2 it pulls along a
 * alone (shear (1 - a^-3)), and not at all where a <= 1. A point for each tri3, three for tri6, four for quad4, nine
 * for quad8 and quad9.
 * - Statics, and steps of several Newton iterations, find the balance with it; a linearised step (max_newton 1) takes
 *   its forces at the start and its stiffness there, without what pressure in it takes off, plus 1e-4 thickness shear
 *   where it wrinkles. Rayleigh damping leaves it out.
 * - A static solve goes evenly from the thickness, shear and prestretch that the last one ended with to the present
 *   ones; a new membrane has all of its stiffness at once, and starts from prestretch 1.
 * - When the mesh changes, it goes with its faces as pressures do, and a face that is cut keeps what of it is material;
 *   where the rest shape of nodes moves, so does its.
 * Errors, with nothing added: SB_ERROR_ARGUMENT (NULL; no faces; corners; a face that no element has, or between two:
 * error->node is its first; a face without area; thickness, shear or prestretch out of range), SB_ERROR_INDEX (a node
 * out of range: error->node), SB_ERROR_NOT_FINITE, SB_ERROR_MEMORY, SB_ERROR_UNSUPPORTED (in a body of
 * SB_CENTRAL_DIFFERENCE one that does not wrinkle: it stiffens without bound as it is pressed together).
 * Source: Pipkin 1986 (relaxed energy); Holzapfel 2000, 6.5, for incompressible sheets. */
SB_API sb_result sb_body_add_membrane(sb_body *body, const sb_membrane_def *def, int *load_id, sb_error *error);
/* Changes between steps, without allocation; ranges and errors as above, SB_ERROR_INDEX: no membrane has this id. */
SB_API sb_result sb_body_set_membrane(sb_body *body, int load_id, sb_real thickness, sb_real shear, sb_real prestretch);

typedef enum sb_membrane_form {
    SB_MEMBRANE_SLACK = 0,
    SB_MEMBRANE_WRINKLED = 1,
    SB_MEMBRANE_TAUT = 2
} sb_membrane_form;

/* A face of a membrane, at its middle. */
typedef struct sb_membrane_state {
    sb_real stretch[2];    /* larger first, of the sheet: prestretch counts */
    sb_real tension[2];    /* N/m of the deformed sheet, laid smooth where it wrinkles: along either stretch */
    sb_vec3 direction;     /* unit: of the larger stretch, in space */
    sb_membrane_form form; /* SB_MEMBRANE_TAUT for one that does not wrinkle */
} sb_membrane_state;

/* Faces that a membrane has now (a change of the mesh may divide them), and their corner nodes, corners[count][corners]
 * as its def had them; either may be NULL. SB_ERROR_ARGUMENT, SB_ERROR_INDEX. */
SB_API sb_result sb_body_membrane_faces(const sb_body *body, int load_id, int *count, int *corners);
/* states[count] at the present shape; no allocation. SB_ERROR_ARGUMENT, SB_ERROR_INDEX. */
SB_API sb_result sb_body_membrane_states(const sb_body *body, int load_id, sb_membrane_state *states);

#endif /* SB_MEMBRANE_H */
