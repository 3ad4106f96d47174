/* heat: temperatures in a body by conduction, blood and applicators; the damage they do, and stiffness that follows:
 * ablation. Floor 4.
 *
 * Pennes' equation on the nodes of the body's mesh,
 *     c T' = div(k grad T) - w (T - T_a) + Q + sources,
 * with what the tissue of each region has for c, k, w, Q, and Arrhenius' law for the damage Om of each node,
 *     Om' = A exp(-E_a / (R T)) above a temperature that does no harm, R = 8.314 J/(mol K);   share of cells that are
 * dead: 1 - exp(-Om). Blood stops where tissue dies: w = w_0 exp(-Om). Elements of dead tissue may become stiffer while
 * the body moves. Temperatures are in kelvin. Heat is conducted in the body's rest shape, along its own tissue: moving
 * or straining it changes nothing of this.
 *
 * ```c fragment
 * sb_heat_def warm = sb_default_heat_def(); // liver at 310.15 K
 * sb_heat *heat = NULL;
 * sb_vec3 tip = sb_v3((sb_real)0.02, 0, 0), shaft = sb_v3((sb_real)0.04, 0, 0);
 * int id;
 * warm.stiffening = 4; // dead tissue is five times as stiff
 * if (sb_heat_create(body, &warm, &heat, &error) == SB_OK &&
 *     sb_heat_add_source(heat, tip, shaft, (sb_real)0.002, 30, &id, &error) == SB_OK)
 *     for (int k = 0; k < 1200; k++) // 30 W for ten minutes
 *         if (sb_heat_step(heat, (sb_real)0.5, NULL, &error) != SB_OK)
 *             break;
 * printf("%.1f ml are dead\n", 1e6 * (double)sb_heat_dead_volume(heat));
 * sb_heat_destroy(heat);
 * ```
 *
 * All elements are taken but clouds; masses are lumped (HRZ), so that tet4 and hex8 of decent shape do not overshoot.
 * Errors of temperatures fall with the square of the element size and with dt (implicit Euler). Results have the same
 * bits for any number of threads. */
#ifndef SB_HEAT_H
#define SB_HEAT_H

#include "../body/body.h"

typedef struct sb_heat sb_heat;

/* What the tissue of a region does with heat. */
typedef struct sb_heat_tissue {
    sb_real conductivity; /* k (W/(m K)), > 0; default 0.5 */
    sb_real capacity;     /* c (J/(m^3 K)), density times specific heat, > 0; default 3.8e6 */
    sb_real perfusion;    /* w (W/(m^3 K)), >= 0: flow of blood (1/s, per volume of tissue) times its density and
                           * specific heat; default 24041, of 0.0064 1/s */
    sb_real metabolic;    /* Q (W/m^3), >= 0; default 0: start from body temperature, where blood takes it away */
    sb_real latent_heat;  /* J/m^3, >= 0, taken up between def.latent_low and def.latent_high; default 0. Boiling
                           * tissue: some 1.8e9 */
} sb_heat_tissue;
SB_API sb_heat_tissue sb_default_heat_tissue(void);

typedef struct sb_heat_region {
    int region; /* value in mesh.regions */
    sb_heat_tissue tissue;
} sb_heat_region;

/* What heat is made from. Start from sb_default_heat_def(). */
typedef struct sb_heat_def {
    sb_heat_tissue tissue;         /* of every region that regions does not name */
    const sb_heat_region *regions; /* [region_count] or NULL */
    int region_count;
    const sb_real *perfusion;        /* [sb_body_element_count] in place of the tissues', or NULL (default) */
    const sb_real *metabolic;        /* [sb_body_element_count] in place of the tissues', or NULL (default) */
    sb_real start;                   /* K, > 0: of all nodes; default 310.15 */
    sb_real blood;                   /* T_a (K), > 0; default 310.15 */
    sb_real latent_low, latent_high; /* K, 0 < low < high; default 372.15 and 374.15 */
    sb_real log_frequency;           /* ln A, A in 1/s; default ln 7.39e39, of liver */
    sb_real activation;              /* E_a (J/mol), > 0; default 2.577e5, of liver */
    sb_real harmless;                /* K, > 0: up to here nothing dies; default 316.15, 43 C. Laws fitted at 50 C and
                                      * more say too much where tissue is well: this one that a fifth dies in 12
                                      * minutes at 37 C */
    int keeps_perfusion;             /* 0 (default): blood stops as tissue dies; 1: it does not */
    sb_real stiffening;              /* s > -1: an element is 1 + s D times as stiff, D the mean share of its nodes that
                                      * is dead: all stresses of its material, fibres and Prony terms too. Default 0 */
    sb_real tolerance;               /* of a solve, residual over its first one, (0, 1); default 1e-8 (float 1e-5) */
    int max_iterations;              /* of each linear solve, >= 1; default 1000 */
    unsigned cookie;                 /* set by sb_default_heat_def */
} sb_heat_def;
SB_API sb_heat_def sb_default_heat_def(void);

/* Heat of a body, one for each at most. Takes all memory for steps from the body's allocator. It becomes part of the
 * body's saved states, recordings and hashes: create it in the body that loads them, too. Destroy it before the body.
 * The def's arrays are copied. Errors, with *heat untouched: SB_ERROR_ARGUMENT (the field, element or region is named;
 * the body has one already), SB_ERROR_NOT_FINITE, SB_ERROR_INDEX (a region that the mesh does not have),
 * SB_ERROR_UNSUPPORTED (def.slack, or clouds), SB_ERROR_MEMORY. */
SB_API sb_result sb_heat_create(sb_body *body, const sb_heat_def *def, sb_heat **heat, sb_error *error);
/* The body is as stiff as its materials again. NULL is fine. */
SB_API void sb_heat_destroy(sb_heat *heat);

/* ---- what heats and cools: may change between steps ----
 * Each checks its arguments first and changes nothing on failure; error may be NULL. Surfaces without any of these are
 * insulated. Faces are given by their corners, faces[face_count][corners], as for sb_body_add_traction; SB_ERROR_INDEX
 * and SB_ERROR_ARGUMENT name the first that is none of the surface (error->node), or a node or element. Adders may
 * allocate (SB_ERROR_MEMORY) and give an id, which may be NULL. */
/* The nodes have these temperatures (K, > 0) from the next step on; one for all when uniform is 1. */
SB_API sb_result sb_heat_hold(sb_heat *heat, const int *nodes, int count, const sb_real *temperatures, int uniform,
                              sb_error *error);
SB_API sb_result sb_heat_release(sb_heat *heat, const int *nodes, int count, sb_error *error);
/* An applicator's power (W, below 0: it cools) around the line from one place of the rest shape to another (m; or the
 * same: a ball): nodes get it by their volume times exp(-d^2 / (2 radius^2)), d their distance. All of it arrives,
 * however coarse the mesh; radius 0: at the nearest nodes. */
SB_API sb_result sb_heat_add_source(sb_heat *heat, sb_vec3 from, sb_vec3 to, sb_real radius, sb_real power, int *id,
                                    sb_error *error);
/* Power (W) at nodes by these shares[count], which sum to 1; NULL: evenly. */
SB_API sb_result sb_heat_add_node_source(sb_heat *heat, const int *nodes, int count, const sb_real *shares,
                                         sb_real power, int *id, sb_error *error);
/* Power per volume (W/m^3) in elements; NULL and 0: in all. */
SB_API sb_result sb_heat_add_element_source(sb_heat *heat, const int *elements, int count, sb_real density, int *id,
                                            sb_error *error);
/* Power per area (W/m^2) into faces. */
SB_API sb_result sb_heat_add_flux(sb_heat *heat, const int *faces, int face_count, int corners, sb_real flux, int *id,
                                  sb_error *error);
/* Faces that give coefficient (W/(m^2 K), >= 0) times their temperature above the surroundings' (K, > 0). */
SB_API sb_result sb_heat_add_convection(sb_heat *heat, const int *faces, int face_count, int corners,
                                        sb_real coefficient, sb_real surroundings, int *id, sb_error *error);
/* Another power (W), density (W/m^3) or flux (W/m^2) of what was added as such; without allocation. SB_ERROR_INDEX: no
 * source has this id. */
SB_API sb_result sb_heat_set_source(sb_heat *heat, int id, sb_real value);
SB_API sb_result sb_heat_set_convection(sb_heat *heat, int id, sb_real coefficient, sb_real surroundings);
/* Takes a source or convection away. */
SB_API sb_result sb_heat_remove(sb_heat *heat, int id);
/* What it gives the body at present (W). */
SB_API sb_result sb_heat_power(const sb_heat *heat, int id, sb_real *power);
SB_API sb_result sb_heat_set_blood(sb_heat *heat, sb_real temperature); /* K, > 0 */
/* temperatures[node_count] (K, > 0), but for nodes that are held; SB_ERROR_NOT_FINITE and SB_ERROR_ARGUMENT name the
 * node. Damage stays. */
SB_API sb_result sb_heat_set_temperatures(sb_heat *heat, const sb_real *temperatures, sb_error *error);
/* def.start everywhere, no damage, nothing in the balance; sources and held nodes stay. */
SB_API void sb_heat_reset(sb_heat *heat);

/* ---- stepping ---- */

/* Heat that went where; W in an info, J in a balance. What comes in less what goes out is stored:
 *     source + metabolic - perfused - convected - held - stored = error, */
typedef struct sb_heat_flows {
    double source;    /* from sources and fluxes */
    double metabolic; /* of the tissue */
    double perfused;  /* carried away by blood */
    double convected; /* through faces with convection */
    double held;      /* through nodes that are held */
    double stored;
    double error; /* of the equations' solution: rounding (1e-12 of the largest); with latent heat of def.tolerance */
} sb_heat_flows;

typedef struct sb_heat_info {
    int iterations;      /* of conjugate gradients, all systems together */
    int systems;         /* 1; with latent heat more */
    double residual;     /* out-of-balance power at the end over that at the start */
    sb_heat_flows flows; /* W, mean over the step */
    sb_real highest;     /* K, and the node that has it */
    int highest_node;
    sb_real dead_volume; /* m^3, as sb_heat_dead_volume */
} sb_heat_info;

/* Advances by dt (s, > 0) with implicit Euler: temperatures, then damage, then the elements' stiffness. Keep dt where
 * sources or damage change little within it, 1 s and less. Damage is integrated along the line between both
 * temperatures, by trapezoids of 1 K and less. Allocates nothing. info and error may be NULL. A step that fails is
 * undone: SB_ERROR_ARGUMENT, SB_ERROR_NOT_CONVERGED, SB_ERROR_INDEFINITE, SB_ERROR_DIVERGED (not finite, or below 0 K,
 * naming the node). */
SB_API sb_result sb_heat_step(sb_heat *heat, sb_real dt, sb_heat_info *info, sb_error *error);
/* Temperatures that no longer change under the present sources, with blood where tissue is alive by now. Damage,
 * stiffness and balance stay as they are. Also SB_ERROR_UNCONSTRAINED, naming a node of a part that nothing holds,
 * cools or perfuses, but for what rounding would take beside what it conducts (2e-12 of that). */
SB_API sb_result sb_heat_solve_steady(sb_heat *heat, sb_heat_info *info, sb_error *error);

/* ---- readings: no allocation ---- */
SB_API const sb_real *sb_heat_temperatures(const sb_heat *heat); /* [node_count] (K), valid until destroyed */
SB_API const sb_real *sb_heat_damage(const sb_heat *heat);       /* [node_count] Om, valid until destroyed */
/* shares[node_count]: 1 - exp(-Om), 0 alive to 1 dead. */
SB_API void sb_heat_dead_shares(const sb_heat *heat, sb_real *shares);
/* Volume of tissue at rest (m^3) times the share of it that is dead, summed. */
SB_API sb_real sb_heat_dead_volume(const sb_heat *heat);
/* factors[sb_body_element_count] of the elements' stiffness, see def.stiffening. */
SB_API void sb_heat_stiffness(const sb_heat *heat, sb_real *factors);
/* Sums of all steps since creation or the last reset (J). */
SB_API sb_heat_flows sb_heat_balance(const sb_heat *heat);

#endif /* SB_HEAT_H */
