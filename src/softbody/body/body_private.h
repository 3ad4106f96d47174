/* body_private: what is inside an sb_body. Internal: body*.c keep it, step.c moves it. */
#ifndef SB_BODY_PRIVATE_H
#define SB_BODY_PRIVATE_H

#include "../fem/assembly.h"
#include "body.h"
#include "body_guest.h"
#include "cavity.h"
#include "elimination.h"
#include "step_touch.h"

enum { SBI_STEP_MOST_GUESTS = 128 }; /* of a step in which contact couples nodes, or nodes hang on rigid bodies */

typedef enum sbi_load_kind {
    SBI_LOAD_PRESSURE = 1,
    SBI_LOAD_SPRINGS = 2,
    SBI_LOAD_MAPPING = 3,
    SBI_LOAD_POTENTIAL = 4,
    SBI_LOAD_CABLE = 5,
    SBI_LOAD_MEMBRANE = 6,
    SBI_LOAD_CAVITY = 7
} sbi_load_kind;

/* What a cable is made of. */
typedef struct sbi_cable_law {
    sb_real rest;      /* m, > 0 */
    sb_real stiffness; /* N, per strain */
    sb_real toe;       /* strain up to which it straightens; 0: at once */
    int pushes;        /* 1: it resists being shorter as well */
} sbi_cable_law;

/* A cable as it lies at some shape; scratch. Where point k comes from and goes to: the length changes by slope[k] .
 * dx_k.
 */
typedef struct sbi_cable_lie {
    sb_real length, tension, rate; /* m, N, N/m: d tension / d length */
    double energy;                 /* J */
    sb_vec3 *way, *slope;          /* [row_count] unit direction to the next point (the last: 0), d length / d point */
    sb_real *part;                 /* [row_count] distance to the next point (m) */
    int *dofs;                     /* [3 entries] 3 node + axis of each, and what they have of slope: */
    sb_real *shares;
} sbi_cable_lie;

/* What a membrane is made of. */
typedef struct sbi_membrane_law {
    sb_real thickness;  /* m, > 0 */
    sb_real shear;      /* Pa */
    sb_real prestretch; /* > 0 */
    int wrinkles;       /* 1: it does not resist being pressed together */
} sbi_membrane_law;

/* What a cavity is filled with, beside a table. */
typedef struct sbi_cavity_law {
    sb_cavity_kind kind;
    sb_real pressure, ambient, exponent, bulk; /* see sb_cavity_def */
    sb_real filled; /* m^3; of a table what was injected, and of SB_CAVITY_PRESSURE where its energy is 0 */
    sb_real share;  /* of a table's pressure that is there: 1, less while a static solve begins */
} sbi_cavity_law;

/* How a liquid, or a volume, is held: p = pressure + stiff (V(pressure) - V), V(.) that of the law. State. */
typedef struct sbi_cavity_hold {
    sb_real pressure; /* Pa */
    sb_real stiff;    /* Pa/m^3 */
} sbi_cavity_hold;

/* An edge of a rim: nodes from, at the middle (-1: none), to, the way that its lid goes round. */
typedef struct sbi_cavity_edge {
    int nodes[3];
    int loop;         /* number of its rim */
    sb_vec3 share[3]; /* of dV/dx (m^2) */
} sbi_cavity_edge;

typedef struct sbi_cavity {
    sbi_cavity_law law, balanced;
    int point_count;
    sb_real table_volume[SB_MAX_CAVITY_POINTS], table_pressure[SB_MAX_CAVITY_POINTS];
    sbi_cavity_hold hold, saved, kept; /* now, at the start of a step, and of a load increment */
    sb_real read;                      /* Pa, in the last solve */
    int rim_count;
    sbi_cavity_edge *rim;           /* [rim_count] or NULL: closed; each rim is a run of them */
    sb_vec3 *share;                 /* [row_start[row_count]] of dV/dx (m^2), as it was laid last, like: */
    double volume, pressure, stiff; /* m^3, Pa, -dp/dV (Pa/m^3) */
} sbi_cavity;

/* A load that follows the body (see load.h). Springs are a mapping with one node of weight 1 in each row; a pressure's
 * rows are the nodes of its faces. A potential has rows without targets, whose owner fills force, stiffness and lines
 * (see body_guest.h); it is in the list only while a solve has it. A cable's rows are its points, in order, with no
 * stiffness; one in space is a row of one weight, 0, and its place is its target. A membrane's rows are those of a
 * pressure, as are those of a cavity. State: stiffness, target, pressure,
 * their balanced twins, balanced, force, net. */
typedef struct sbi_load {
    sbi_load_kind kind;
    int id;
    void *memory;        /* the one block behind the arrays */
    int row_count;       /* springs, rows, or faces */
    int *row_start;      /* [row_count + 1] */
    int *nodes;          /* [row_start[row_count]] */
    int *blocks;         /* for each row, the matrix block of each pair of its nodes */
    int pattern_version; /* of the pattern that blocks are positions in; -1: of none yet */
    int balanced;        /* 1: a static solve has ended with the balanced values */

    sb_element_type *face_types;         /* [row_count] of faces */
    sb_real pressure, balanced_pressure; /* Pa */
    int has_parts;                       /* 1: some of its faces are cut */

    sb_real *weights; /* [row_start[row_count]] of rows; of faces see sbi_body_face_loads, where they have parts */
    sb_real *stiffness, *balanced_stiffness; /* [row_count] (N/m) */
    sb_vec3 *target, *balanced_target; /* [row_count] (m) displacement H^T u that the row is drawn to: kept like this,
                                        * and not as a position, the force has the displacement's precision */
    sb_vec3 *force;                    /* [row_count] (N) on the body, in the last solve */
    sb_vec3 *lines;    /* [row_count] or NULL: none. A row's stiffness is then k [(1 - l.l) I + l l^T]: across the
                        * line l, of at most unit length, it is that much softer. Of a mapping in line_memory,
                        * and NULL again where a registration's call ends */
    void *line_memory; /* of a mapping that has had lines; or NULL */
    void (*fill)(void *user, const sb_vec3 *u, sb_vec3 *force, sb_real *stiffness, sb_vec3 *lines); /* of a potential */
    void *fill_user;
    double net[6]; /* force (N) and torque about the origin (N m) in the last solve */
    /* of a cable */
    sbi_cable_law cable, balanced_cable;
    sb_real tension;      /* N, in the last solve */
    double curved_energy; /* J, of a cable, membrane or cavity, where that ended */
    sbi_cable_lie lie;
    sbi_membrane_law membrane, balanced_membrane; /* of a membrane */
    sbi_cavity cavity;                            /* of a cavity */
} sbi_load;

/* 1: its rows are faces. */
SB_INLINE int sbi_load_has_faces(const sbi_load *load)
{
    return load->kind == SBI_LOAD_PRESSURE || load->kind == SBI_LOAD_MEMBRANE || load->kind == SBI_LOAD_CAVITY;
}

/* A traction on a face, or on a piece's part of it. */
typedef struct sbi_traction {
    int nodes[6];   /* 3 of tet4, the rest -1; 6 of tet10 */
    sb_vec3 stress; /* Pa on undeformed area */
} sbi_traction;

/* What an explicit body knows of its stability; part of the state, zeros: nothing yet. */
typedef struct sbi_step_guard {
    sb_real stable_step; /* at the last look (s) */
    int age;             /* substeps since */
    int monitor_open;    /* 1: energy means something */
    int caution, calm;   /* plan of substeps, and calls that went well with it */
    double energy;       /* what the body has left of what it was given (J): more cannot be in its motion */
} sbi_step_guard;

/* What steps keep of their tangent, see step_kept.c. Of two places of each array made.slot tells the present one. */
typedef struct sbi_kept_made {
    int valid, slot;
    sb_real mass, stiffness;   /* its factors, as sbi_step has them */
    sbi_precond_memory before; /* what the preconditioner remembered when it was made of it */
} sbi_kept_made;
typedef struct sbi_kept {
    sb_real angle; /* rad: elements that have turned by more ask for another one; 0: each step makes its own */
    int current;   /* 1: body->matrix, support_blocks and precond are what follows from `made` */
    size_t rotation_count;
    sb_real mass, stiffness;   /* factors of the step at work */
    sbi_kept_made made, saved; /* saved: at the start of that */
    sb_real *rotations[2];     /* [rotation_count] as assembly.batch_quats */
    sb_vec3 *positions[2];     /* [node_capacity] (m) of the preconditioner's pieces */
    uint64_t stamps[2], count; /* of what was written there last: its number of all */
} sbi_kept;

/* A call that changed a body, as its observer hears of it. A new mutator gets a code here, tells its body, and gets a
 * row in the replay table of record.c. Codes stand in files: never change one. */
typedef enum sbi_command_code {
    SBI_COMMAND_DESTROY = 0,   /* the body is about to go */
    SBI_COMMAND_MATERIAL = 1,  /* a: 1 for all regions, 2 for its tension only; ints: region, model, Prony terms; reals:
                                * packed material,  and its prestretch where it has one */
    SBI_COMMAND_GRAVITY = 2,   /* reals: 3 */
    SBI_COMMAND_DAMPING = 3,   /* reals: alpha, beta */
    SBI_COMMAND_SOLVER = 4,    /* a: max_iterations; reals: tolerance */
    SBI_COMMAND_FIX = 5,       /* a: axes; ints: nodes */
    SBI_COMMAND_PRESCRIBE = 6, /* a: axes, b: sum of SBI_PRESCRIBE_...; ints: nodes; reals: targets */
    SBI_COMMAND_RELEASE = 7,   /* a: axes; ints: nodes */
    SBI_COMMAND_FORCES = 8,    /* b: uniform; ints: nodes; reals: forces */
    SBI_COMMAND_TRACTION = 9,  /* a: corners; ints: faces; reals: 3 */
    SBI_COMMAND_CLEAR_LOADS = 10,
    SBI_COMMAND_DISPLACEMENTS = 11, /* reals: one vector per node */
    SBI_COMMAND_VELOCITIES = 12,    /* reals: one vector per node */
    SBI_COMMAND_RESET = 13,
    SBI_COMMAND_STATE = 14,        /* bytes: what sb_body_state_load took */
    SBI_COMMAND_STEP = 15,         /* a: result; reals: dt */
    SBI_COMMAND_STATIC = 16,       /* a: result; ints: load_steps, max_newton, max_iterations, keep_progress,
                                    * instantaneous + 2 quasi_newton + 4 forces_only + 8 newton + 32 start (0: the present
                                    * shape, 1: SB_START_AUTO, 2: rotations); reals: tolerance */
    SBI_COMMAND_FIBRES = 17,       /* a: 0 takes them away, b: 2 of the second family; reals: one vector per element */
    SBI_COMMAND_ADD_PRESSURE = 18, /* a: corners; ints: faces; reals: pressure */
    SBI_COMMAND_PRESSURE = 19,     /* a: load; reals: pressure */
    SBI_COMMAND_ADD_SPRINGS = 20,  /* b: uniform; ints: nodes; reals: points, stiffness */
    SBI_COMMAND_ADD_MAPPING = 21, /* a: rows, b: uniform; ints: row starts, nodes; reals: targets, stiffness, weights */
    SBI_COMMAND_POINTS = 22,      /* a: load, b: its kind; reals: points */
    SBI_COMMAND_STIFFNESS = 23,   /* a: load, b: uniform; ints: its kind; reals: stiffness */
    SBI_COMMAND_REMOVE_LOAD = 24, /* a: load */
    SBI_COMMAND_ADD_CONSTRAINTS = 25,    /* a: count; ints: starts (from any number), unknowns; reals: values,
                                          * coefficients */
    SBI_COMMAND_CONSTRAINT_VALUE = 26,   /* a: constraint; reals: value */
    SBI_COMMAND_REMOVE_CONSTRAINTS = 27, /* a: first, b: count */
    SBI_COMMAND_CLEAR_CONSTRAINTS = 28,
    SBI_COMMAND_CHANGE = 29,         /* ints and reals: the calls of a change of the mesh, see live_change.c */
    SBI_COMMAND_PLACE = 32,          /* ints: the preconditioner's memory; reals: one displacement per node */
    SBI_COMMAND_LINES = 33,          /* a: load; reals: one line per row, or none to take them away */
    SBI_COMMAND_PART = 34,           /* ints: name of a part of the state, and its own; reals: its own */
    SBI_COMMAND_PART_STEP = 35,      /* a: result; the same of a step */
    SBI_COMMAND_REGION_DAMPING = 36, /* a: region; reals: alpha, beta */
    SBI_COMMAND_ADD_CABLE = 37, /* a: points, b: 1 when it pushes; ints: row starts, nodes; reals: places, rest length,
                                 * stiffness, toe strain, weights */
    SBI_COMMAND_CABLE = 38,     /* a: load; reals: rest length, stiffness */
    SBI_COMMAND_POSE = 39,      /* ints: nodes; reals: centre, position, quaternion (w x y z) */
    SBI_COMMAND_KEEP_TANGENT = 40, /* reals: angle */
    SBI_COMMAND_ADD_MEMBRANE = 41, /* a: corners, b: 1 when it wrinkles; ints: faces; reals: as below */
    SBI_COMMAND_MEMBRANE = 42,     /* a: load; reals: thickness, shear modulus, prestretch */
    SBI_COMMAND_ADD_CAVITY = 43, /* a: corners, b: kind; ints: faces; reals: pressure, ambient, exponent, bulk, then of
                                  * a table volumes, pressures */
    SBI_COMMAND_CAVITY = 44,     /* a: load; reals: pressure, filled */
    SBI_COMMAND_ADD_RIGID = 45,  /* ints: nodes; reals: mass, inertia by rows, centre, turn (w x y z), velocity, spin */
    SBI_COMMAND_RIGID_LOAD = 46, /* a: rigid body; reals: force, torque */
    SBI_COMMAND_REMOVE_RIGID = 47, /* a: rigid body */
    SBI_COMMAND_COUNT
} sbi_command_code;

/* Of SBI_COMMAND_PRESCRIBE: one target for all; targets are positions, not displacements. */
enum { SBI_PRESCRIBE_UNIFORM = 1, SBI_PRESCRIBE_POSITIONS = 2 };

/* Arguments; ints and reals go on in the lists behind them, which are one with them for who hears of it later. */

typedef struct sbi_command {
    sbi_command_code code;
    int a, b;
    const int *ints;
    const sb_real *reals;
    const unsigned char *bytes;
    size_t int_count, real_count, byte_count;
    const int *more_ints;
    size_t more_int_count;
    const sb_real *more_reals[2];
    size_t more_real_counts[2];
} sbi_command;

struct sb_body {
    sb_allocator allocator;
    /* Hears of every call that changed the body (of solves also when they failed), after the change; or NULL. */
    void (*observe)(void *observer, const sbi_command *command);
    void *observer;
    struct sbi_state_parts *parts; /* what others save with it, see state_part.h; or NULL */
    struct sbi_touch *touch;       /* what touches it, see step_touch.h; or NULL */
    sbi_touch_keeper touch_keeper; /* who keeps that, or zeros */
    unsigned char *substep_room;   /* what a step that is divided gives back, see step_substeps.c; or NULL */
    size_t substep_room_size;
    const sbi_guest *step_guests[SBI_STEP_MOST_GUESTS]; /* of a step that touch or
                                                         * rigid bodies add some to */
    sb_jobs jobs;
    sb_clock clock;

    /* what it is made of */
    sb_domain domain;
    int own_points; /* 1: the domain came with the def, not from the elements */
    sb_matrix matrix;
    sb_preconditioner *precond;
    int auto_solver; /* 1: the def left the choice of it to the library */
    sb_pcg_workspace pcg;
    sbi_assembly assembly;
    int node_capacity;      /* node slots that the arrays by node have room for */
    void *memory;           /* the one block behind the arrays by node */
    void *topology_memory;  /* the one behind those by part and by block of the matrix, and those in assembly */
    struct sbi_live *live;  /* slots, shares and listeners of a mesh that may change; NULL: def.slack was 0 */
    int material_count;     /* one per region of the mesh */
    int *material_regions;  /* [material_count] ascending region numbers */
    sb_material *materials; /* [material_count] */
    sb_material *twins;     /* [material_count] scratch: corotated materials that static solves start from */
    sb_real *made_young;    /* [material_count] Young's moduli at creation (Pa): multigrid's levels are made from them,
                             * also those of another mesh, so that they do not depend on when that came */
    int *cell_material;     /* [cell_count] */
    const sb_material_law **laws; /* [law_count] of the caller, that materials had: states know them by name */
    int law_count;
    sb_vec3 *fibres; /* [cell_count] unit directions or 0; NULL: none were given */
    sb_vec3
        *second_fibres;  /* [cell_count] of the second family; NULL: none. Only where fibres are, and the mesh stays */
    sb_real force_unit;  /* stiffness times volume over size (N): times epsilon, rounding in the forces */
    int component_count; /* connected parts */
    sb_index_table element_component;
    sb_index_lists node_elements;
    int *node_component; /* [node_count], -1: no element */

    /* couplings beyond the elements: each row's nodes have blocks with each other in the matrix */
    int extra_count;
    int *extra_start;     /* [extra_count + 1] */
    int *extra_nodes;     /* [extra_start[extra_count]] */
    void *pattern_memory; /* behind mass_blocks and the assembly's pair_start once the pattern has grown */
    int pattern_version;  /* rises when the pattern changes: block positions kept elsewhere are stale then */

    /* settings */
    sb_mass_kind mass_kind;
    sb_integrator integrator;
    sb_vec3 gravity;
    sb_real damping_mass, damping_stiffness;
    int regional_damping;    /* 1: regions have their own, below */
    sb_real *region_alpha;   /* [material_count] (1/s), one block with the next two */
    sb_real *region_beta;    /* [material_count] (s) */
    sb_real *region_factors; /* [material_count] scratch of a step: of each region's stiffness */
    sb_real tolerance, newton_tolerance;
    int max_iterations, max_newton;
    sb_real spectral_radius;
    int max_substeps;

    /* mass */
    sb_real *lumped_mass;  /* [node_count] (kg) */
    sb_real *node_damping; /* [node_count] (kg/s) what the regions' alphas make of it; 0 without regional_damping */
    sb_real *part_scale;   /* [parts of the matrix] largest force (N) of each, to compare its residual with */
    sb_real *mass_blocks;  /* [block_count] (kg) scalar mass of each matrix block, or NULL: lumped */
    sb_real *load_mass;    /* [node_count] (kg) int rho N dV: what gravity pulls at in a static solve */

    /* supports and loads */
    unsigned char *fixed;    /* [node_count] axes as bits; unreferenced nodes always all */
    sb_vec3 *target;         /* [node_count] target displacement of fixed axes (m) */
    sb_vec3 *dead_load;      /* [node_count] forces and tractions (N) */
    sbi_traction *tractions; /* what of it are tractions, of a body that may be cut */
    int traction_count, traction_capacity;
    sbi_load *loads; /* [load_count] by ascending id */
    int load_count, load_capacity, last_load_id;
    int tie_count, tie_capacity;  /* parts that rows of mappings tie to each other */
    int *tie_of;                  /* [component_count] number among the tied parts, or -1 */
    double *tie_gram;             /* [6 tie_capacity][6 tie_capacity] scratch, like support_grams for all of them */
    int support_used;             /* blocks in the rows of nodes with fixed axes */
    int support_capacity;         /* blocks that support_blocks holds */
    sb_real (*support_blocks)[9]; /* tangent rows of nodes with fixed axes, kept before they are masked */
    sb_real (*damping_blocks)[9]; /* stiffness at the start of a step of several iterations, for D; or NULL */
    double (*support_grams)[36];  /* [component_count] what the supports do to rigid motions */
    sb_vec3 *component_low, *component_high; /* [component_count] bounding boxes (m) */
    int (*component_faces)[6]; /* [component_count] nodes in each side of the boxes: low x, y, z, high x, y, z */

    struct sbi_rigids *rigids; /* that move freely, see rigid_private.h; NULL: there has been none */

    /* constraints */
    sbi_elimination *elimination; /* the system they condense, or NULL: none */
    int next_constraint;          /* number of the next one */

    /* state */
    sb_vec3 *reference; /* [node_count] (m) */
    sb_vec3 *position, *displacement, *velocity, *acceleration;
    int acceleration_known;    /* 0: the next Newmark step solves M a = f first */
    sb_real acceleration_step; /* s, of the step that left the acceleration; 0: no matter */
    int force_current;         /* 1: internal holds the force at displacement */
    sbi_step_guard guard;
    sbi_kept *kept; /* NULL: no step has been asked to keep anything */

    /* vectors of a solve, [node_count] each */
    sb_vec3 *internal;     /* internal force (N) */
    sb_vec3 *external;     /* loads of the last solve (N) */
    sb_vec3 *follower;     /* forces of `loads` at the displacement of the last residual (N) */
    sb_vec3 *equilibrated; /* dead loads that the last static solve ended with (N) */
    sb_vec3 *residual;     /* M a + D v + internal - external */
    sb_vec3 *rhs, *increment, *reaction;
    sb_vec3 *previous;                  /* increment of the iteration of contact before */
    sb_vec3 *velocity0, *acceleration0; /* v = cv (u - start) + velocity0, a likewise */
    sb_vec3 *start;                     /* displacement at the start of the step */
    sb_vec3 *saved_velocity, *saved_acceleration, *saved_reaction, *saved_external, *saved_internal;
    int saved_force_current, saved_fold_fallback;
    sbi_precond_memory saved_precond;
    sb_vec3 *converged; /* displacement at the last converged load increment */
    sb_vec3 *work, *work2;
};

/* All that depends on the pattern of the matrix, made anew before any of it is put in place. A caller with matrices
 * of its own makes them from `matrix` between sbi_body_make_pattern and sbi_body_take_pattern, so that it can still
 * give up. */
typedef struct sbi_body_pattern {
    int needed; /* 0: every row fits the present pattern, and nothing was made */
    sb_matrix matrix;
    sb_preconditioner *precond;
    sbi_elimination *elimination; /* NULL: the body has no constraints */
    int extra_count;
    int *extra_start, *extra_nodes;
    void *memory;
    sb_real *mass_blocks; /* NULL: lumped */
    int *pair_start;      /* NULL: not a batched body */
    int support_used, support_capacity;
    void *support_blocks; /* NULL: the present ones are large enough */
    void *damping_blocks; /* NULL: the body has none */
} sbi_body_pattern;

/* Makes the pattern in which the nodes of each of the rows cells[cell_start[c]] .. cells[cell_start[c + 1]] - 1 are
 * coupled too, beside the elements' and those of all rows before. SB_ERROR_MEMORY, SB_ERROR_INDEX (a node out of
 * range): nothing was made. Takes nothing when every row fits already. */
SBI_API sb_result sbi_body_make_pattern(const sb_body *body, int cell_count, const int *cell_start, const int *cells,
                                        sbi_body_pattern *pattern, sb_error *error);
/* The rest of a pattern whose rows (extra_...) are there, for supports that may be still to come (fixed[node_count]);
 * no elimination. On failure the pattern is freed, rows included. */
/* The matrix of the elements, of ties between them, and of extra rows of nodes. */
SBI_API sb_result sbi_body_make_matrix(const sb_body *body, int extra_count, const int *extra_start,
                                       const int *extra_nodes, sb_matrix *matrix, sb_error *error);
SBI_API sb_result sbi_body_finish_pattern(const sb_body *body, const unsigned char *fixed, sbi_body_pattern *pattern,
                                          sb_error *error);
/* Puts it in place; cannot fail. Values of the matrix and what the preconditioner learnt are gone, the state is not. */
SBI_API void sbi_body_take_pattern(sb_body *body, sbi_body_pattern *pattern);
/* Gives it up. */
SBI_API void sbi_body_free_pattern(const sb_body *body, sbi_body_pattern *pattern);
/* What an elimination is made for with this matrix; borrowed from the body. */
SBI_API sbi_elimination_setup sbi_body_elimination_setup(const sb_body *body, const sb_matrix *matrix);
/* Makes and takes: all or nothing. */
SBI_API sb_result sbi_body_extend_pattern(sb_body *body, int cell_count, const int *cell_start, const int *cells,
                                          sb_error *error);
/* 1: an observer hears of calls. */
SBI_API int sbi_body_is_heard(const sb_body *body);
/* Tells the observer, if there is one, of a command without bytes. */
SBI_API void sbi_body_tell(sb_body *body, sbi_command_code code, int a, int b, const int *ints, size_t int_count,
                           const sb_real *reals, size_t real_count);
/* The same for any command. */
SBI_API void sbi_body_tell_command(sb_body *body, const sbi_command *command);

/* Room for so many more tractions by face. SB_ERROR_MEMORY. */
SBI_API sb_result sbi_body_reserve_tractions(sb_body *body, int more, sb_error *error);
/* dead_load += what a traction on a face, or a part of one, gives its nodes. */
SBI_API void sbi_body_spread_traction(const sb_body *body, const sbi_traction *traction, sb_vec3 *dead_load);
/* What of its faces is material, as the body's cells are now; does nothing for a load without faces. */
SBI_API void sbi_load_weigh_faces(const sb_body *body, sbi_load *load);
/* A load of these outer faces, as callers give them; errors of sb_body_add_pressure. */
SBI_API sb_result sbi_load_make_faces(const sb_body *body, sbi_load_kind kind, const int *faces, int face_count,
                                      int corners, sbi_load *load, sb_error *error);
/* Frees its arrays. */
SBI_API void sbi_load_release(const sb_allocator *allocator, const sbi_load *load);

/* What replays sbi_body_place. */
enum { SBI_PLACE_INTS = 4 };
SBI_API sb_result sbi_body_replay_place(sb_body *body, const int *ints, const sb_vec3 *u, sb_error *error);

/* The load with this id and kind (0: any), or NULL. */
SBI_API sbi_load *sbi_load_find(const sb_body *body, int id, int kind);
/* Room for one more, and its place in the list after sbi_load_reserve found it. */
SBI_API sb_result sbi_load_reserve(sb_body *body, sb_error *error);
SBI_API void sbi_load_append(sb_body *body, sbi_load *load, int *load_id);
/* SB_ERROR_ARGUMENT, SB_ERROR_INDEX and SB_ERROR_NOT_FINITE, of sb_body_add_mapping. */
SBI_API sb_result sbi_load_check_mapping(const sb_body *body, const sb_mapping *mapping, sb_error *error);
/* Blocks for the nodes of each row, of a cable for those of all its points, and room for the parts that they tie. */
SBI_API sb_result sbi_load_couple(sb_body *body, const sbi_load *load, sb_error *error);
/* Memory for a load of these rows, zeroed: entries nodes in all, pairs of nodes within rows. */
SBI_API sb_result sbi_load_make(const sb_allocator *allocator, sbi_load_kind kind, int rows, int entries, size_t pairs,
                                sbi_load *load, sb_error *error);

/* The numbers of a material but its model and count of Prony terms, for files: unpack(pack(m)) is m. A law is packed as
 * the mark of its name and found again among those that the body knows; NULL where none is it. */
enum {
    SBI_MATERIAL_TENSION = 2,
    SBI_MATERIAL_PRESTRETCH = 9
}; /* a of SBI_COMMAND_MATERIAL; reals of a
    * prestretch, which are packed apart */
enum {
    SBI_MATERIAL_MODULI = 17,
    SBI_MATERIAL_OGDEN = SBI_MATERIAL_MODULI, /* where the lists start */
    SBI_MATERIAL_PRONY = SBI_MATERIAL_OGDEN + 2 * SB_MAX_OGDEN_TERMS,
    SBI_MATERIAL_REALS = SBI_MATERIAL_PRONY + 2 * SB_MAX_PRONY_TERMS
};
SBI_API void sbi_body_pack_material(const sb_material *material, sb_real *reals);
SBI_API sb_material sbi_body_unpack_material(const sb_body *body, int model, int prony_count, const sb_real *reals);

/* The parts of creation that loading a state needs, too. Checks: */
SBI_API sb_result sbi_body_check_settings(const sb_body_def *def, sb_error *error);
SBI_API sb_result sbi_body_check_material(const sb_material *material, int single_rotation, sb_error *error);
/* arrays by node for node_capacity slots, and those by part and block once the matrix is there; */
SBI_API sb_result sbi_body_take_nodes(sb_body *body, sb_error *error);
SBI_API sb_result sbi_body_take_topology(sb_body *body, sb_error *error);
SBI_API void sbi_body_copy_nodes(sb_body *to, sb_body *from); /* all arrays by node */
SBI_API void sbi_body_swap_nodes(sb_body *a, sb_body *b);     /* each gets the other's */
SBI_API sb_result sbi_body_prepare_assembly(sb_body *body, sb_error *error);
/* gives back the body and all that it has, once nobody listens to it and no change of its mesh is under way; NULL is
 * fine; */
SBI_API void sbi_body_release(sb_body *body);
/* parts of the nodes and their boxes; holds the nodes of no element; */
SBI_API void sbi_body_label_nodes(sb_body *body);
/* A node at x (m) comes to a part's box, which grows, or leaves it; a box whose side has lost its last node is not
 * right any more, and boxes are to be made again; */
SBI_API void sbi_body_enter_box(sb_body *body, int component, sb_vec3 x);
SBI_API void sbi_body_leave_box(sb_body *body, int component, sb_vec3 x);
SBI_API int sbi_body_box_is_right(const sb_body *body, int component);
SBI_API void sbi_body_make_boxes(sb_body *body);
/* regions and materials, one material per region, and each cell's material; */
SBI_API sb_result sbi_body_make_materials(sb_body *body, const sb_body_def *def, sb_error *error);
/* what a material to come, of region `index` (-1: of all), needs besides itself: fibre directions and memory; */
SBI_API sb_result sbi_body_prepare_material(sb_body *body, int index, const sb_material *material, sb_error *error);
SBI_API sb_result sbi_body_make_preconditioner(sb_body *body, const sb_body_def *def, sb_error *error);
/* One like that of the body before its mesh became another: what sbi_body_make_preconditioner gives a body made so. */
SBI_API sb_result sbi_body_remake_preconditioner(sb_body *body, const sb_preconditioner *like, sb_error *error);
/* After a change of the mesh in place: one that does not follow is made anew. A failure leaves it to the next call. */
SBI_API sb_result sbi_body_settle_preconditioner(sb_body *body, sb_error *error);
/* Makes the levels of a multigrid once more and lets them go; the body stays as it is. The first change of the mesh
 * makes new ones beside those that there are: allocators have that memory at hand then, and do not fetch page after
 * page. */
SBI_API sb_result sbi_body_rehearse_preconditioner(sb_body *body, sb_error *error);
/* Moduli of a matrix of the body's nodes as sb_preconditioner_def has them, to be freed with the body's allocator; NULL
 * where there is one material. young: [material_count] (Pa); NULL: those of the materials now. */
SBI_API sb_result sbi_body_make_moduli(const sb_body *body, const sb_real *young, const sb_matrix *matrix,
                                       sb_real **moduli, sb_error *error);
/* directions at unit length; */
SBI_API void sbi_body_copy_fibres(sb_vec3 *out, const sb_vec3 *fibres, int count);
/* memory, which only ever grows: */
SBI_API sb_result sbi_body_reserve_damping(sb_body *body, const sb_material *materials, int count, sb_error *error);
/* Room for material_count regions' damping, and with another body's in it; 0: no memory. */
SBI_API int sbi_body_take_regions(sb_body *body);
SBI_API int sbi_body_copy_regions(sb_body *to, const sb_body *from);
/* Where all damp alike, each region gets what the body has. */
SBI_API void sbi_body_begin_regions(sb_body *body);
/* 1 when some stiffness damps. */
SBI_API int sbi_body_has_beta(const sb_body *body);
/* Regions damp by what they have (1), or all by what the body has (0). */
SBI_API void sbi_body_set_regions(sb_body *body, int regional);
/* node_damping, from the regions' alphas and masses. */
SBI_API void sbi_body_sum_damping(sb_body *body);
/* Index of a region in the ascending list, or where it would stand (then *found is 0). */
SBI_API int sbi_body_find_region(const int *regions, int count, int region, int *found);
SBI_API sb_result sbi_body_reserve_support_blocks(sb_body *body, int needed);
/* and what follows from the materials. */
SBI_API void sbi_body_materials_changed(sb_body *body);
/* assembly.cell_stiffness, which somebody else owns, has other values; the first: because the state that the body has
 * by now was saved with these. */
SBI_API void sbi_body_read_cell_stiffness(sb_body *body);
SBI_API void sbi_body_cells_stiffened(sb_body *body);

/* The largest Poisson's ratio of its materials. */
SBI_API sb_real sbi_body_poisson(const sb_body *body);
/* Updates a preconditioner of the body's, with what its materials are by now. */
SBI_API sb_result sbi_body_update_precond(sb_body *body, sb_preconditioner *precond, sb_matrix *matrix,
                                          const sbi_guests *guests, sb_error *error);
/* The reference mesh as others see it; borrowed arrays. */
SBI_API sb_mesh sbi_body_mesh_view(const sb_body *body);
/* Diagonal of the bounding box (m). */
SBI_API sb_real sbi_body_size(const sb_body *body);
/* Recomputes masses after a density changed. */
SBI_API void sbi_body_update_mass(sb_body *body);
/* Of a body that follows: masses of a cell's corners, and the sums of a node over its cells in ascending order. */
SBI_API void sbi_body_weigh_cell(sb_body *body, int cell, const sbi_tet_rule *rule);
SBI_API void sbi_body_sum_node_mass(sb_body *body, int node);
/* blocks[block_count] (kg) = a mass matrix of any kind, one scalar per block of the pattern. */
/* As sbi_domain_element_mass, of a cell that may be a piece; to be multiplied by sbi_live_density. */
SBI_API int sbi_body_cell_mass(const sb_body *body, int cell, sb_mass_kind kind, const sb_vec3 *x, sb_real *mass,
                               sb_real *volume_load);
SBI_API void sbi_body_mass_blocks(const sb_body *body, sb_mass_kind kind, sb_real *blocks);
/* out = M x for the body's mass matrix. */
SBI_API void sbi_body_mass_multiply(const sb_body *body, const sb_vec3 *x, sb_vec3 *out);
/* matrix += factor * M */
SBI_API void sbi_body_add_mass(sb_body *body, sb_real factor);
/* Newton iterations of a time step, SB_AUTO resolved. */
SBI_API int sbi_body_max_newton(const sb_body *body);
/* position = reference + displacement */
SBI_API void sbi_body_update_positions(sb_body *body);
/* SB_ERROR_ARGUMENT for a NULL body or list, SB_ERROR_INDEX for a node that is not there. */
SBI_API sb_result sbi_body_check_nodes(const sb_body *body, const int *nodes, int count, sb_error *error);
/* One vector for each node, or for all: there, and finite. what: their name. */
SBI_API sb_result sbi_body_check_vectors(const sb_vec3 *vectors, const int *nodes, int count, int uniform,
                                         const char *what, sb_error *error);
/* An element's face as a load sees it. */
typedef struct sbi_body_face {
    sb_element_type type;
    int count;
    int nodes[SB_MAX_FACE_NODES]; /* counter-clockwise from outside */
    int inner;                    /* 1: an element stands on its other side, too */
} sbi_body_face;
/* The face number f of a caller's list faces[][count], or SB_ERROR_INDEX or SB_ERROR_ARGUMENT naming it. count: that of
 * its corners, or of all nodes that a face of the element has. */
SBI_API sb_result sbi_body_get_face(const sb_body *body, const int *faces, int f, int count, sbi_body_face *found,
                                    sb_error *error);
/* The face of a cell. 1 when it is of the surface and the first with its corners: no cell stands on its other side, it
 * has material (a piece's may have none), and no cell before has one with the same corners, as other pieces may. */
SBI_API int sbi_body_outer_face(const sb_body *body, int cell, int side, sbi_body_face *face);
/* Faces with the corners of one that was found, itself first: pieces of a tet10 may share corners and differ in the
 * nodes between them. Returns how many, 1 of all other elements. */
enum { SBI_BODY_TWINS = 35 }; /* an element has at most as many pieces */
SBI_API int sbi_body_twin_faces(const sb_body *body, const sbi_body_face *face, sbi_body_face twins[SBI_BODY_TWINS]);
/* What of a face of tet4 (count 3) or tet10 (6), as found, is material: int N dA over the cells behind it, over the
 * face's area, by its nodes; all of it unless cells are pieces. */
SBI_API void sbi_body_face_loads(const sb_body *body, const int *nodes, int count, sb_real *loads);
/* 1 when the named corners of an element (all different) are those of the list. */
SBI_API int sbi_body_has_corners(const int *list, const int *cell, const int *local, int count);
/* H^T u of a row: the displacement of its point. */
SB_INLINE sb_vec3 sbi_body_row_value(const sbi_load *load, int row, const sb_vec3 *u)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int k = load->row_start[row]; k < load->row_start[row + 1]; k++)
        sum = sb_v3_madd(sum, load->weights[k], u[load->nodes[k]]);
    return sum;
}

/* Sums of displacement components that something holds: rows of mappings, equations of constraints. */
typedef struct sbi_body_rows {
    int count;
    const int *start; /* [count + 1] */
    const int *nodes; /* nodes of the terms, each along every axis; or NULL: */
    const int *dofs;  /* 3 node + axis of the terms */
    const sb_real *weights;
} sbi_body_rows;
/* Room to tell whether parts that these rows tie to each other are supported: to be had before such rows are put in
 * place. SB_ERROR_MEMORY changes nothing. */
SBI_API sb_result sbi_body_reserve_ties(sb_body *body, const sbi_body_rows *rows, sb_error *error);
/* A node of the first connected part whose supports, springs, mappings and constraints leave a rigid motion free, or
 * -1. */
SBI_API int sbi_body_unsupported_node(const sb_body *body);
/* What that is found by: r += weight times what the six rigid motions of its part do to one axis of a node. */
SBI_API void sbi_body_add_motion(const sb_body *body, int node, int axis, double weight, double r[6]);
/* Block (row, column) of six by six of a gram with `stride` numbers a row += r s^T. */
SBI_API void sbi_body_add_gram(double *gram, size_t stride, int row, int column, const double *r, const double *s);
/* A rigid motion that a gram of 6 size numbers holds not, or -1. Uses it up; traces: [parts] */
SBI_API int sbi_body_free_motion(double *gram, int parts, double *traces);
/* support_grams and tie_gram = what holds each part: supports, springs, mappings and constraints. */
SBI_API void sbi_body_gather_holds(const sb_body *body);

/* Axes of node i, as bits, that no equation of the solved system is for: supported or a constraint's slave. */
SB_INLINE unsigned sbi_body_held(const sb_body *body, int i)
{
    return body->elimination ? (unsigned)(body->fixed[i] | body->elimination->slave[i]) : body->fixed[i];
}
/* ---- body_kept ---- */
/* 1: it is of elements whose tangents may be kept. */
SBI_API int sbi_kept_fits(const sb_body *body);
/* Room in `to`, of its own size, for a tangent that it has not made yet; the angle stays what it is. 0: no memory. */
SBI_API int sbi_kept_take(sb_body *to);
/* Nothing is kept any more: what the tangent depends on has changed. */
SBI_API void sbi_kept_forget(sb_body *body);
/* 1: there is a tangent. */
SBI_API int sbi_kept_is_valid(const sb_body *body);
/* The system of a step of these factors and the present shape is made, of a preconditioner that remembered `before`. */
SBI_API void sbi_kept_note(sb_body *body, sbi_precond_memory before);
/* What a step that fails gives back: kept, and given back. */
SBI_API void sbi_kept_save(sb_body *body);
SBI_API void sbi_kept_restore(sb_body *body);
/* For whoever uses the body's matrix, preconditioner or support_blocks for something else. */
SB_INLINE void sbi_kept_spoil(sb_body *body)
{
    if (body->kept)
        body->kept->current = 0;
}

/* Points of an element that others may see: its mean point is ours. */
SB_INLINE int sbi_body_points(const sb_body *body) { return body->domain.points_per_cell - body->domain.mean_points; }
/* F, mean points last, and Cauchy stresses (Pa) at the points of an element; where there is no stress it is 0, and
 * admissible[point] 0. All: [SBI_CELL_POINTS]. */
SBI_API void sbi_body_element_stresses(const sb_body *body, int element, sb_mat3 *f, sb_mat3 *stress, int *admissible);
/* Of the material at rest (m^3); 0 of a free cell. */
SBI_API sb_real sbi_body_element_volume(const sb_body *body, int element);

#endif /* SB_BODY_PRIVATE_H */
