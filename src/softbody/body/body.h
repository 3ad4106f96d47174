/* body: a mesh with material, supports, loads and state. Floor 3. */
#ifndef SB_BODY_H
#define SB_BODY_H

#include "../fem/domain.h"
#include "../fem/material.h"
#include "../solve/pcg.h"
#include "../solve/precond.h"

/* Functions that return an sb_result refuse a NULL body; the others give 0, NULL or zeros for one, or do nothing. */
typedef struct sb_body sb_body;

/* Means "let the library choose" where a def or an option says so. */
enum { SB_AUTO = -1 };

typedef enum sb_integrator {
    SB_EULER = 1,   /* implicit Euler: first order, damps; for trainers */
    SB_NEWMARK = 2, /* average acceleration (beta 1/4, gamma 1/2): second order, keeps the energy of linear bodies; for
                     * studies. Large motions without damping have no bound on their energy: keep dt small, add some */
    SB_GENERALISED_ALPHA = 3, /* Chung and Hulbert 1993: second order, damps what dt cannot resolve and nothing else;
                               * for large or fast motions. spectral_radius says how much */
    SB_CENTRAL_DIFFERENCE = 4 /* explicit: no linear systems, cheap substeps of at most sb_body_stable_step. Second
                               * order. Lumped mass and damping_mass only */
} sb_integrator;

/* The material of one region of the mesh. */
typedef struct sb_region_material {
    int region; /* value in mesh.regions */
    sb_material material;
} sb_region_material;

/* What a body is made from. Start from sb_default_body_def(), set mesh and material, change what you like. */
typedef struct sb_body_def {
    const sb_mesh *mesh;     /* volume mesh (m); read during sb_body_create only, but for the table of
                              * custom elements, which the body keeps */
    const sb_domain *domain; /* integration points of one's own (an immersed grid's) instead of those of the mesh's
                              * elements, or NULL (default). Its cells are the elements of mesh, in their order
                              * and with their nodes; several may have the same nodes. Copied; integration and
                              * single_rotation then stay at their defaults. SB_ERROR_ARGUMENT and
                              * SB_ERROR_NOT_FINITE name the cell that does not fit */
    sb_material material;    /* of every region that region_materials does not name */
    const sb_region_material *region_materials; /* [region_material_count] or NULL */
    int region_material_count;
    const sb_vec3 *fibres;        /* [element_count] direction of the fibres at rest, of any length; 0: this element
                                   * has none. Read during sb_body_create only. A material with fibres needs it;
                                   * default NULL */
    const sb_vec3 *second_fibres; /* the same of a second family, of the same material, or NULL (default); needs fibres.
                                   * SB_ERROR_UNSUPPORTED with slack */
    sb_integration integration;   /* integration points per element; default SB_INTEGRATION_AUTO.
                                   * SB_INTEGRATION_BBAR: tet10, hex8, hex20 and hex27 that do not lock when nearly
                                   * incompressible; SB_INTEGRATION_PATCH: tet4 that do not; otherwise
                                   * all do in some measure, see sb_check_report */
    int single_rotation;          /* 1: tet10 with one rotation per element, of its mean (corotated only); default
                                   * 0. Cheaper; forces are still the slope of an energy, so that they conserve
                                   * momentum. Within an element strain is linear, so that it should turn by less
                                   * than 0.1 rad from side to side: a cantilever bent to a slope of 1 deflects 0.1
                                   * % too far with 20 elements along it (0.2 % without), 0.1 % too little with 10,
                                   * 3 % with 5 (2 % without) */
    sb_mass_kind mass;            /* default SB_MASS_LUMPED */
    sb_integrator integrator;     /* of sb_body_step; default SB_EULER */
    sb_real spectral_radius;      /* SB_GENERALISED_ALPHA: what a step leaves of the highest frequencies, [0, 1];
                                   * 1 damps nothing, 0 kills them in one step; default 0.5. A soft
                                   * beam falling about its clamp with large steps: Newmark and 0.8 gain energy
                                   * without bound, 0.5 and less gain none */
    int max_substeps;             /* SB_CENTRAL_DIFFERENCE: most substeps of one sb_body_step, >= 1; default 10000 */
    sb_vec3 gravity;              /* m/s^2; default 0 */
    sb_real damping_mass;         /* Rayleigh alpha (1/s), >= 0; default 0 */
    sb_real damping_stiffness;    /* Rayleigh beta (s), >= 0; default 0 */
    sb_precond_kind preconditioner;   /* of conjugate gradients; default SB_PRECOND_AUTO, which looks at the size:
                                       * sb_body_solver tells what it chose. Linearised steps of corotated particles
                                       * with at most springs, mappings and potentials as loads make no matrix where
                                       * no diagonal entry of it is more than 12 times the node's mass term (M / dt^2
                                       * of SB_EULER): products go from point to point, and the diagonal alone
                                       * preconditions, a tenth of the time. With SB_PRECOND_NONE they never make one,
                                       * and nothing preconditions; other kinds always have a matrix */
    const sb_multigrid_level *levels; /* [level_count] of SB_PRECOND_MULTIGRID, from fine to coarse, copied; not with
                                       * slack. Default NULL: made from the nodes' places and the materials of now, also
                                       * for another mesh later (materials that are set later change the time of a
                                       * solve, and its last bits) */
    int level_count;
    sb_real tolerance;        /* of a linearised step's solve, |r| / |b|, in (0, 1); default 1e-3. Iterated steps
                               * choose theirs from newton_tolerance. Each connected part meets it by itself,
                               * however light; b has M v / dt, but parts that nothing holds keep their momentum
                               * to this share of the forces, however fast they are; touched by tools, of weights,
                               * loads and tools' forces in magnitude or, where that is more, of a hundredth of the
                               * forces within that are out of balance, unless contact was cut short
                               * (sb_contact_info.capped). Within a part it says nothing of what is soft or light
                               * there beside the rest */
    int max_iterations;       /* of a step's linear solve; bounds a frame's time; default 500 */
    int max_newton;           /* Newton iterations per step: 1 is the linearised step of real-time work;
                               * SB_AUTO (default): 1 for linear and, with Euler, corotated; 20 otherwise. With
                               * generalised alpha and 1, corotated bodies that spin freely gain energy without bound:
                               * turning by 0.02 rad a step 1.3 times in 300 steps, by 0.05 a million times in 240;
                               * damping_stiffness does not help. With Euler they gain none, nor with 20 up to 0.2 rad */
    sb_real newton_tolerance; /* relative residual of a step with several iterations, in each connected part;
                               * default 1e-6 */
    sb_real slack;            /* > 0: the mesh may change (live_mesh.h), and this share of its nodes and elements
                               * is in reserve, so that pointers to arrays by node stay valid while it lasts;
                               * [0, 1000], default 0. SB_ERROR_UNSUPPORTED with def.domain or def.levels */
    sb_allocator allocator;   /* default malloc */
    sb_jobs jobs;             /* default inline */
    sb_clock clock;           /* for sb_step_info's times; default NULL */
    unsigned cookie;          /* set by sb_default_body_def; a def made without it is refused */
} sb_body_def;

SB_API sb_body_def sb_default_body_def(void);

/* Creates a body at rest in the mesh's shape. All memory that stepping needs is taken here. On failure *body is
 * untouched and the error says what is wrong: SB_ERROR_ARGUMENT and SB_ERROR_NOT_FINITE (field or node named),
 * SB_ERROR_MESH (element named), SB_ERROR_INDEX (node index, or a region that the mesh does not have),
 * SB_ERROR_MATERIAL (the material, or the element whose material has fibres but that no direction was given for),
 * SB_ERROR_UNSUPPORTED (element left out by SB_ELEMENT), SB_ERROR_MEMORY. Destroy with sb_body_destroy. */
SB_API sb_result sb_body_create(const sb_body_def *def, sb_body **body, sb_error *error);
SB_API void sb_body_destroy(sb_body *body); /* NULL is fine */

/* ---- sizes ---- */
SB_API int sb_body_node_count(const sb_body *body);
SB_API int sb_body_element_count(const sb_body *body);
SB_API int
sb_body_point_count(const sb_body *body); /* points per element that sb_body_stress reads; hex8 8, B-bar too */
SB_API int sb_body_matrix_blocks(const sb_body *body); /* stored 3x3 blocks of the tangent */
SB_API int sb_body_patch_count(const sb_body *body);   /* of SB_INTEGRATION_PATCH, otherwise 0 */
/* The patch of an element, from 0; -1 without patches, for an element that there is not, or NULL. */
SB_API int sb_body_patch(const sb_body *body, int element);

/* What solves its linear systems, and how the last set-up went. The kind is never SB_PRECOND_AUTO;
 * sb_precond_string names it. */
SB_API sb_preconditioner_info sb_body_solver(const sb_body *body);
/* Diagonal of the body's bounding box over 3 V/A at rest, V its volume and A its surface: 3.5 of a cube, 5.2 of a ball,
 * L/h of some 25 from 30 on: thin. Costs a pass over the integration points, and uses the body's scratch: between steps
 * only. NULL: 0. */
SB_API sb_real sb_body_slenderness(const sb_body *body);

/* ---- properties: may change between steps ----
 * Each checks its arguments first and changes nothing on failure. A material may allocate when it is the first whose
 * steps take several iterations, or that has so many Prony terms (SB_ERROR_MEMORY). An element whose material is set
 * forgets what its Prony terms remember: it counts as long relaxed in its present shape. */
SB_API sb_result sb_body_set_material(sb_body *body, const sb_material *material, sb_error *error); /* all regions */
SB_API sb_result sb_body_set_region_material(sb_body *body, int region, const sb_material *material, sb_error *error);
/* Directions as in the def, copied; NULL takes them all away. SB_ERROR_NOT_FINITE names the element; SB_ERROR_MATERIAL
 * when a material has fibres and fibres is NULL; the first call may allocate (SB_ERROR_MEMORY). What Prony terms
 * remember of the stress along the old directions stays and fades. */
SB_API sb_result sb_body_set_fibres(sb_body *body, const sb_vec3 *fibres, sb_error *error);
/* The same of the second family (sb_body_def.second_fibres); NULL takes it away, as sb_body_set_fibres(NULL) does.
 * SB_ERROR_ARGUMENT without a first one, SB_ERROR_UNSUPPORTED in a body whose mesh may change. */
SB_API sb_result sb_body_set_second_fibres(sb_body *body, const sb_vec3 *fibres, sb_error *error);
/* Tension (Pa) >= 0 with which the fibres of a region contract from now on: sb_material.fibre_tension, changed without
 * forgetting what Prony terms remember. Set it before each step to drive it in time. SB_ERROR_INDEX: no such region;
 * SB_ERROR_MATERIAL: no fibres to contract, or a material without energy for them. */
SB_API sb_result sb_body_set_tension(sb_body *body, int region, sb_real tension, sb_error *error);
SB_API sb_result sb_body_set_gravity(sb_body *body, sb_vec3 gravity);
/* Of all regions. SB_ERROR_UNSUPPORTED: beta > 0 with SB_CENTRAL_DIFFERENCE. */
SB_API sb_result sb_body_set_damping(sb_body *body, sb_real alpha, sb_real beta);
/* Damping of a region's own, in place of the body's, which the others keep: its elements damp with beta (s) times their
 * stiffness, and its share of the nodes' lumped masses with alpha (1/s), whatever def.mass is; both >= 0. What ties
 * cells of a cut keeps the body's beta. sb_body_set_damping gives all regions the same again. With SB_EULER steps cost
 * what they did; steps of one iteration of other integrators assemble one matrix more, for which the first call
 * allocates. SB_ERROR_ARGUMENT, SB_ERROR_INDEX (no such region), SB_ERROR_UNSUPPORTED (SB_CENTRAL_DIFFERENCE),
 * SB_ERROR_MEMORY change nothing. */
SB_API sb_result sb_body_set_region_damping(sb_body *body, int region, sb_real alpha, sb_real beta, sb_error *error);
/* Tolerance in (0, 1) and cap (>= 1) of a step's linear solve. */
SB_API sb_result sb_body_set_solver(sb_body *body, sb_real tolerance, int max_iterations);
/* Lets linearised steps (max_newton 1) go on with the tangent and the preconditioner of a step before, which are most
 * of what a step costs that moves little. angle (rad, 0 to 1): they are made anew once an element has turned by more
 * since; 0, as bodies are made: in each step. 0.02 to 0.1 serve. Forces and damping are those of the present shape in
 * any case, and so is the tangent times the way that nodes coast: a step is off by about the angle times what its
 * motion changes by within it, and bodies come to rest where they would otherwise. Where the works of the kept and of
 * the present tangent on that change differ by more than a share of 0.25, or of the angle where that is less, the step
 * is solved once more, with its own, which sb_step_info counts: nearly incompressible or slender bodies would gain
 * energy in long steps. What is kept is part of the state.
 *
 * Made anew in each step all the same: where materials are not all SB_COROTATED, where there are constraints, loads
 * that follow the body (springs, mappings, membranes ...), tools, contact, damping by region, glue or supports that
 * move, with multigrid, and by needles with NDL_REMESH; and once after each change of dt, supports, materials or mesh.
 * Allocates; the steps do not. SB_ERROR_ARGUMENT, SB_ERROR_UNSUPPORTED (elements other than tet4), SB_ERROR_MEMORY
 * change nothing; error may be NULL. */
SB_API sb_result sb_body_keep_tangent(sb_body *body, sb_real angle, sb_error *error);

/* ---- supports ----
 * Calls on nodes say what went wrong in an sb_error, their last argument, which may be NULL, and change nothing then;
 * what they set in space is a position (m), as for springs and needles.
 *
 * A supported degree of freedom follows its target; a step moves it there exactly. A slave axis of a constraint cannot
 * be supported (SB_ERROR_ARGUMENT). axes is a sum of SB_X (1), SB_Y (2), SB_Z (4), SB_XYZ all three. nodes[count] are
 * node indices; SB_ERROR_INDEX names the first that is out of range, SB_ERROR_NOT_FINITE the first without a place. May
 * allocate (to remember the support rows of the tangent): SB_ERROR_MEMORY leaves the supports as they were. Nodes of no
 * element are always supported on all axes: they go where they are prescribed (as reference nodes of constraints),
 * releasing them does nothing, loads on them are refused, and their reactions are those of constraints. */
/* Holds the axes where the nodes are now. */
SB_API sb_result sb_body_hold(sb_body *body, const int *nodes, int count, int axes, sb_error *error);
/* Supports the axes; the next step takes them to positions[count] (m, in space). */
SB_API sb_result sb_body_place(sb_body *body, const int *nodes, int count, int axes, const sb_vec3 *positions,
                               sb_error *error);
/* Nodes that hang on a rigid body moved by its pose (a bone, a clamp, a moving table): supports all axes, and the next
 * step takes each node from its place X at rest to position + turn (X - centre). centre (m) is a point of the rest
 * shape, position (m) where it goes; turn is taken at unit length. A step goes there exactly; the increments of a
 * static solve go straight, so that a large turn is better made in several solves. SB_ERROR_NOT_FINITE;
 * SB_ERROR_ARGUMENT (a turn of length 0). What the body feels of it: sb_body_wrench. */
SB_API sb_result sb_body_place_rigid(sb_body *body, const int *nodes, int count, sb_vec3 centre, sb_vec3 position,
                                     sb_quat turn, sb_error *error);
/* Frees the axes; their velocity stays. */
SB_API sb_result sb_body_release(sb_body *body, const int *nodes, int count, int axes, sb_error *error);
/* The same without an error, as earlier versions had them; sb_body_prescribe's targets are displacements from the
 * reference shape: displacements[count] (m), or one for all when uniform is 1. */
SB_API sb_result sb_body_fix_nodes(sb_body *body, const int *nodes, int count, int axes);
SB_API sb_result sb_body_prescribe(sb_body *body, const int *nodes, int count, int axes, const sb_vec3 *displacements,
                                   int uniform);
SB_API sb_result sb_body_release_nodes(sb_body *body, const int *nodes, int count, int axes);
/* Supported axes of every node as bits, [node_count]. */
SB_API const unsigned char *sb_body_supports(const sb_body *body);

/* ---- state ---- */
SB_API const sb_vec3 *sb_body_positions(const sb_body *body);     /* [node_count] (m), valid until destroyed */
SB_API const sb_vec3 *sb_body_displacements(const sb_body *body); /* [node_count] (m) */
SB_API const sb_vec3 *sb_body_velocities(const sb_body *body);    /* [node_count] (m/s) */
/* Overwrites the motion (any finite values, inside-out shapes included); SB_ERROR_NOT_FINITE changes nothing. To Prony
 * terms a new shape is a sudden strain: their memory stays. What comes after agrees with the original run up to
 * rounding, not to the last bit: solver warm starts are not part of it (sb_body_state_load has them), nor is a tangent
 * that steps keep. */
SB_API sb_result sb_body_set_displacements(sb_body *body, const sb_vec3 *displacements);
SB_API sb_result sb_body_set_velocities(sb_body *body, const sb_vec3 *velocities);
/* Back to the reference shape at rest, with nothing remembered; supports, loads and materials stay. */
SB_API void sb_body_reset(sb_body *body);

/* ---- readings: no allocation ---- */
/* Force (N) of the supports on the body, per node, 0 on free axes, of the last step or static solve; with the
 * loads it balances the rate of momentum. At the end of the step; with SB_GENERALISED_ALPHA where that scheme has its
 * balance, a share 1/(1 + spectral_radius) of the way through it (at the end where it had to take 0). [node_count],
 * valid until the next solve. */
SB_API const sb_vec3 *sb_body_reactions(const sb_body *body);
/* The net force (N) of what holds these nodes on the body, and its torque (N m) about a point (m, in space), as
 * sb_body_reactions has them: a clamp, a bone or a table feels the opposite. Either place may be NULL. nodes[count],
 * each once. SB_ERROR_INDEX, SB_ERROR_NOT_FINITE leave both untouched. */
SB_API sb_result sb_body_wrench(const sb_body *body, const int *nodes, int count, sb_vec3 about, sb_vec3 *force,
                                sb_vec3 *torque, sb_error *error);
/* All loads of the last solve (gravity, forces, tractions, and what pressures, springs and mappings exerted in it) as
 * nodal forces (N), [node_count]. */
SB_API const sb_vec3 *sb_body_external_forces(const sb_body *body);
/* SB_ERROR_INVERTED or SB_ERROR_NOT_FINITE (too large for sb_real) leave *energy untouched. */
typedef struct sb_energy {
    sb_real elastic; /* J. With Prony terms the energy of the long-term response, which is what slow unloading gives
                      * back; what the terms hold besides will be dissipated and is not in it */
    sb_real kinetic; /* J */
    sb_real springs; /* J, of springs, mappings, cables and membranes at their present stiffness and points; dead loads
                      * and pressures have no energy of their own */
} sb_energy;
SB_API sb_result sb_body_energy(sb_body *body, sb_energy *energy);
/* y = K x, the stiffness at the present displacements times x: the change of the internal forces (N) when the nodes
 * move by x (m). x and y: [node_count], not overlapping. K is the derivative of the forces, symmetric but not always
 * positive definite; Prony terms respond at once. With single_rotation it is that of the same elements with a rotation
 * at each point. Supports, loads and constraints have no say. The state stays as it is, and nothing is allocated.
 * SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE (error->node) and SB_ERROR_INVERTED (error->element) leave y untouched; error
 * may be NULL. */
SB_API sb_result sb_body_multiply_stiffness(sb_body *body, const sb_vec3 *x, sb_vec3 *y, sb_error *error);
/* The same with the tangent that solves use: SB_TANGENT_EXACT is the derivative of above, SB_TANGENT_SPD its positive
 * semidefinite projection at each point, and SB_TANGENT_QUASI what linearised steps take: of the corotated models the
 * rotations stay as they are (K = R C R^T), others are projected. SB_TANGENT_QUASI of SB_COROTATED tet4 and tet10 needs
 * no matrix: measured, that takes a tenth (tet10) to two fifths (tet4) of assembling one and multiplying.
 * SB_ERROR_ARGUMENT: also an unknown kind. */
SB_API sb_result sb_body_multiply_tangent(sb_body *body, sb_tangent_kind kind, const sb_vec3 *x, sb_vec3 *y,
                                          sb_error *error);
/* That matrix itself (N/m; for SB_TANGENT_EXACT the derivative of the internal forces by the nodes' places), lent until
 * the next call on the body, whose copy of it this overwrites. Errors as above; *matrix is then untouched. */
SB_API sb_result sb_body_stiffness_matrix(sb_body *body, sb_tangent_kind kind, const sb_matrix **matrix,
                                          sb_error *error);
/* Total mass (kg) and momentum (kg m/s). */
SB_API sb_real sb_body_mass(const sb_body *body);
SB_API sb_vec3 sb_body_momentum(const sb_body *body);
/* Cauchy stress (Pa) at an integration point of an element, from the current state, with what fibres and Prony terms
 * add. SB_ERROR_INDEX,
 * SB_ERROR_INVERTED (material has no stress there); *stress is then untouched. */
SB_API sb_result sb_body_stress(const sb_body *body, int element, int point, sb_mat3 *stress);
/* Von Mises stress (Pa) of every element, mean over its points (over their weights where def.domain was given), 0 where
 * there is none; values[element_count]. */
SB_API void sb_body_von_mises(const sb_body *body, sb_real *values);
/* The same as nodal averages weighted by volume, for colouring; values[node_count]. */
SB_API void sb_body_nodal_von_mises(const sb_body *body, sb_real *values);
/* How the material around each node has turned from the reference shape, as unit quaternions: the rotation of the mean
 * deformation gradient, weighted by volume; identity where there is no material. rotations[node_count], as
 * sb_preconditioner_warp takes them. Uses the body's scratch: between steps only. */
SB_API void sb_body_nodal_rotations(sb_body *body, sb_quat *rotations);

/* A part of a body: what hangs together by elements that share a node. Couplings by constraints, springs and mappings
 * do not count, nor do empty pieces of a cut. */
typedef struct sb_part {
    int node;       /* its lowest node with material, which stays with its material however the body is cut */
    int node_count; /* its nodes with material */
    sb_real volume; /* at rest (m^3) */
    sb_real mass;   /* kg */
    sb_vec3 centre; /* of mass, where the part is now (m) */
} sb_part;
/* Lists the parts by ascending `node`.
 * parts     [capacity] the first `capacity` of them; NULL when capacity is 0
 * *count    how many there are
 * numbers   [sb_body_node_count] number of the part of each node, -1: it has no material; or NULL
 * Allocates nothing; uses the body's scratch: between steps only. SB_ERROR_ARGUMENT. */
SB_API sb_result sb_body_parts(sb_body *body, sb_part *parts, int capacity, int *count, int *numbers);

/* ---- set-up check ---- */
/* What looks wrong, as bits of sb_check_report.warnings. */
enum {
    SB_CHECK_SIZE = 1,          /* bounding box over 10 m or under 1 mm: units? */
    SB_CHECK_DENSITY = 2,       /* a density outside 100 .. 10,000 kg/m^3: units? */
    SB_CHECK_STIFFNESS = 4,     /* a Young's modulus outside 10 Pa .. 10 MPa: not soft tissue, units? */
    SB_CHECK_SLIVERS = 8,       /* elements of quality under 0.1 */
    SB_CHECK_LOCKING = 16,      /* a material's Poisson's ratio above what the elements bear: they lock, which is to say
                                 * that they are too stiff by more than the mesh makes them anyway. See below */
    SB_CHECK_UNREFERENCED = 32, /* nodes that belong to no element; held in place */
    SB_CHECK_UNSUPPORTED = 64,  /* a part whose supports leave rigid motions free: no static solve */
    SB_CHECK_COMPONENTS = 128,  /* more than one connected part */
    SB_CHECK_DUPLICATES = 256   /* elements with the same corners as another: their mass and stiffness count twice. Not
                                 * looked for where def.domain was given: its cells may well share their nodes */
};
/* Locking. Elements other than B-bar ones and tet4 with patches resist changes of volume at more points than a nearly
 * incompressible material leaves them motions for. Measured on even and distorted meshes of a thick tube, 5 cells
 * across, and of a thick sphere, 3 (linear elements 6) cells across, under pressure (tests/verification.md,
 * verification_locking): up to the limit no element loses more than 2 % of its displacement against Poisson's ratio
 * 0.3, and this is what they lose beyond.
 *
 *     element         limit   0.45    0.49    0.499   0.4999
 *     tet4            0.35     9 %    27 %     44 %     48 %
 *     hex8            0.4      5 %    24 %     75 %     95 %
 *     hex20, hex27    0.49   < 1 %     2 %     14 %     63 %
 *     tet10           0.495  < 1 %     1 %      5 %     20 %
 *     B-bar           none   0.2 % and less (tet10, hex8, hex20, hex27)
 *     tet4, patches   none   0.4 % and less (SB_INTEGRATION_PATCH)
 *
 * Meshes that are finer, or graded towards where the load is, lose less; what is held on all sides loses more. Custom
 * elements count as hex8 when they have no nodes but corners, otherwise as hex20. */
typedef struct sb_check_report {
    unsigned warnings;     /* SB_CHECK_ bits; 0: nothing suspicious */
    sb_real size;          /* diagonal of the bounding box (m) */
    sb_real worst_quality; /* of any element, 1 is regular */
    int worst_element;
    int sliver_count;
    int unreferenced_count;
    int component_count;
    int duplicate_count;
    int locking_count;     /* elements whose material is beyond the limit of their type */
    int locking_element;   /* the first of them, or -1 */
    sb_real locking_limit; /* Poisson's ratio above which elements of this type lock, see above; 0.5: they do not */
    int unsupported_component_node; /* a node of the first unsupported part or free rigid body, or -1 */
} sb_check_report;
/* SB_ERROR_ARGUMENT; SB_ERROR_MEMORY of a body with free rigid bodies. */
SB_API sb_result sb_body_check(const sb_body *body, sb_check_report *report);
/* One sentence about one SB_CHECK_ bit; never NULL. */
SB_API const char *sb_check_string(unsigned warning);

#endif /* SB_BODY_H */
