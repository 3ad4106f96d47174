/* sensitivity: how an equilibrium answers to loads and parameters: solves with its tangent, derivatives of
 * displacements and reactions, gradients of a loss. Floor 4.
 *
 * ```c fragment
 * sb_vec3 *loss = calloc((size_t)sb_body_node_count(body), sizeof *loss);
 * sb_parameter young;
 * sb_real slope;
 * memset(&young, 0, sizeof young);
 * young.kind = SB_PARAMETER_YOUNG;
 * young.region = 0;
 * if (loss && sb_body_solve_static(body, NULL, NULL) == SB_OK) {
 *     loss[0].z = 1; // how high node 0 is: d(loss) / du
 *     sb_body_gradient(body, loss, NULL, &young, 1, &slope, NULL, &error); // slope in m/Pa
 * }
 * free(loss);
 * ```
 *
 * All calls are about the present shape, which has to be an equilibrium under the present loads and supports: the end
 * of sb_body_solve_static with nothing changed since (materials with Prony terms: long after). A shape whose forces are
 * out of balance by more than 1e-6 of the loads and reactions (what rounding may leave is allowed) is refused with
 * SB_ERROR_NOT_CONVERGED, as is one whose supports or constraints have yet to move: nothing is guessed. K is the exact
 * tangent, not projected, with springs, mappings and pressures in it; the part of a pressure's that is not symmetric,
 * along the open rim of its faces, is iterated for, so that derivatives hold there too. Derivatives are those of the
 * equation that is solved: their error is about that of the equilibrium.
 *
 * Each call leaves the body's state as it is, to the last bit, and gives the same bits for any number of threads. It
 * takes memory from the body's allocator for the time of the call: a copy of the tangent, and up to 10,000 nodes its
 * Cholesky factor (beyond, or where memory does not suffice, conjugate gradients). Outputs are untouched on failure,
 * error may be NULL. Common errors: SB_ERROR_ARGUMENT; SB_ERROR_NOT_FINITE and SB_ERROR_INDEX (naming a node);
 * SB_ERROR_NOT_CONVERGED (see above); SB_ERROR_UNCONSTRAINED naming a node of a part that can move freely;
 * SB_ERROR_INVERTED naming an element; SB_ERROR_INDEFINITE: the shape is not stable, it buckles; SB_ERROR_MEMORY;
 * SB_ERROR_UNSUPPORTED: something presses on the body (contact.h; tools that touch nothing do not matter), a single
 * rotation per element (def.single_rotation), whose tangent is not exact, or a parameter of the elements in a body
 * whose mesh may change (def.slack). */
#ifndef SB_SENSITIVITY_H
#define SB_SENSITIVITY_H

#include "../body/body.h"
#include "../body/load.h"

/* x = K^-1 rhs for `count` right-hand sides: what small forces (N) added to the present loads displace (m).
 *   rhs        [count][node_count] (N); on supported axes it has no effect
 *   x          [count][node_count] (m): 0 on supported axes, slaves of constraints follow their masters; may be rhs
 *   tolerance  of conjugate gradients, |rhs - K x| / |rhs|, (0, 1); where rounding stops them above it, up to 1e4
 *              SB_EPSILON will do. A factored solve is as exact as rounding lets it be
 * A factored solve of many right-hand sides at once costs much less than one after the other. */
SB_API sb_result sb_body_solve_tangent(sb_body *body, const sb_vec3 *rhs, sb_vec3 *x, int count, sb_real tolerance,
                                       sb_error *error);

/* What a derivative is with respect to. */
typedef enum sb_parameter_kind {
    SB_PARAMETER_YOUNG = 1,     /* Young's modulus (Pa) of a region at constant Poisson's ratio: all moduli of its
                                 * material in proportion (a law of one's own and its D1), fibres left out */
    SB_PARAMETER_POISSON = 2,   /* Poisson's ratio of a region at constant Young's modulus; not of a law of one's own */
    SB_PARAMETER_CONSTANT = 3,  /* one constant of a region's material, the others constant */
    SB_PARAMETER_DENSITY = 4,   /* of a region (kg/m^3): its weight */
    SB_PARAMETER_GRAVITY = 5,   /* along an axis (m/s^2) */
    SB_PARAMETER_FORCE = 6,     /* a dead force (N) along an axis on each of the nodes */
    SB_PARAMETER_PRESSURE = 7,  /* of a load (Pa) */
    SB_PARAMETER_STIFFNESS = 8, /* of a spring or a row of a mapping (N/m); of all of a load alike with row SB_AUTO */
    SB_PARAMETER_TARGET = 9,    /* the point (m) that a spring or a row is drawn to, along an axis; all with SB_AUTO */
    SB_PARAMETER_SUPPORT = 10   /* where the nodes, supported along the axis, are held (m): all alike */
} sb_parameter_kind;

/* Constants of a material that its stress is linear in, but D1: its reciprocal. */
typedef enum sb_constant {
    SB_CONSTANT_LAMBDA = 1, /* lambda and mu (Pa): of models that evaluate them, see sb_material */
    SB_CONSTANT_MU = 2,
    SB_CONSTANT_C10 = 3, /* Pa; C20 and C30 of SB_REDUCED_POLYNOMIAL, C01 of SB_MOONEY_RIVLIN */
    SB_CONSTANT_C01 = 4,
    SB_CONSTANT_C20 = 5,
    SB_CONSTANT_C30 = 6,
    SB_CONSTANT_D1 = 7,              /* 1/Pa, of isochoric models */
    SB_CONSTANT_FIBRE_STIFFNESS = 8, /* k1 (Pa), of materials with fibres */
    SB_CONSTANT_FIBRE_TENSION = 9,   /* T (Pa) */
    SB_CONSTANT_OGDEN_MU = 10        /* mu_1 (Pa), + i for mu_(i+1): of the terms that the material has */
} sb_constant;

/* A parameter; fields that its kind does not name are not read. Plain data: zero it first. */
typedef struct sb_parameter {
    sb_parameter_kind kind;
    int region;       /* YOUNG, POISSON, CONSTANT, DENSITY: value in mesh.regions */
    int constant;     /* CONSTANT: an sb_constant */
    int load_id;      /* PRESSURE, STIFFNESS, TARGET */
    int row;          /* STIFFNESS, TARGET: [0, rows), or SB_AUTO: all */
    int axis;         /* GRAVITY, FORCE, TARGET, SUPPORT: 0 x, 1 y, 2 z */
    const int *nodes; /* FORCE, SUPPORT: [node_count], borrowed for the call */
    int node_count;
} sb_parameter;

/* Derivatives of displacements and of reactions, one solve for each parameter.
 *   parameters  [parameter_count]
 *   du          [parameter_count][node_count]: du/dp (m per unit of the parameter)
 *   dreaction   [parameter_count][node_count]: of sb_body_reactions, the force (N) of the supports on the body; or NULL
 * More errors: SB_ERROR_ARGUMENT naming the parameter: no such kind, axis or constant in its material, a node that is
 * not supported along the axis; SB_ERROR_INDEX: no such region, load or row.
 * Method: K du/dp = -dr/dp, r = f_int - f_ext; reactions dr_s/dp + K_sf du_f/dp. dr/dp is exact: stresses are linear in
 * constants, loads in theirs. */
SB_API sb_result sb_body_sensitivities(sb_body *body, const sb_parameter *parameters, int parameter_count, sb_vec3 *du,
                                       sb_vec3 *dreaction, sb_error *error);

/* Gradient of a loss J(u, reactions) with respect to any number of parameters by one solve (adjoint).
 *   dj_du         [node_count] dJ/du (J's unit per m); or NULL: 0
 *   dj_dreaction  [node_count] dJ/d(reaction) (per N), of no effect on axes that are free; or NULL: 0
 *   parameters    [parameter_count], NULL where parameter_count is 0
 *   gradient      [parameter_count] dJ/dp: what goes through the equilibrium. What J has of p by itself is to be added
 *   dj_dforce     [node_count] dJ/d(dead force on each node) (per N), or NULL
 * Errors as sb_body_sensitivities.
 * Method: K^T l = dJ/du + K^T w with w = dJ/dR on supports, m = l - w, dJ/dp = -m . dr/dp; of supports
 * dJ/du - K^T m. */
SB_API sb_result sb_body_gradient(sb_body *body, const sb_vec3 *dj_du, const sb_vec3 *dj_dreaction,
                                  const sb_parameter *parameters, int parameter_count, sb_real *gradient,
                                  sb_vec3 *dj_dforce, sb_error *error);

#endif /* SB_SENSITIVITY_H */
