/* body_state: what is inside an sb_body. Floor 3, internal: body.c keeps it, step.c moves it. */
#ifndef SB_BODY_STATE_H
#define SB_BODY_STATE_H

#include "assembly.h"
#include "body.h"

/* A call that changed a body, as its observer hears of it. A new mutator gets a code here, tells its body, and gets a
 * row in the replay table of record.c. Codes stand in files: never change one. */
typedef enum sbi_command_code {
    SBI_COMMAND_DESTROY = 0,       /* the body is about to go */
    SBI_COMMAND_MATERIAL = 1,      /* a: 1 for all regions; ints: region, model, Prony terms; reals: packed material */
    SBI_COMMAND_GRAVITY = 2,       /* reals: 3 */
    SBI_COMMAND_DAMPING = 3,       /* reals: alpha, beta */
    SBI_COMMAND_SOLVER = 4,        /* a: max_iterations; reals: tolerance */
    SBI_COMMAND_FIX = 5,           /* a: axes; ints: nodes */
    SBI_COMMAND_PRESCRIBE = 6,     /* a: axes, b: uniform; ints: nodes; reals: displacements */
    SBI_COMMAND_RELEASE = 7,       /* a: axes; ints: nodes */
    SBI_COMMAND_FORCES = 8,        /* b: uniform; ints: nodes; reals: forces */
    SBI_COMMAND_TRACTION = 9,      /* a: corners; ints: faces; reals: 3 */
    SBI_COMMAND_CLEAR_LOADS = 10,
    SBI_COMMAND_DISPLACEMENTS = 11,/* reals: one vector per node */
    SBI_COMMAND_VELOCITIES = 12,   /* reals: one vector per node */
    SBI_COMMAND_RESET = 13,
    SBI_COMMAND_STATE = 14,        /* bytes: what sb_body_state_load took */
    SBI_COMMAND_STEP = 15,         /* a: result; reals: dt */
    SBI_COMMAND_STATIC = 16,       /* a: result; ints: load_steps, max_newton, max_iterations, keep_progress;
                                    * reals: tolerance */
    SBI_COMMAND_COUNT
} sbi_command_code;

typedef struct sbi_command {
    sbi_command_code code;
    int a, b;
    const int *ints;
    const sb_real *reals;
    const unsigned char *bytes;
    size_t int_count, real_count, byte_count;
} sbi_command;

struct sb_body {
    sb_allocator allocator;
    /* Hears of every call that changed the body (of solves also when they failed), after the change; or NULL. */
    void (*observe)(void *observer, const sbi_command *command);
    void *observer;
    sb_jobs jobs;
    sb_clock clock;

    /* what it is made of */
    sb_domain domain;
    sb_matrix matrix;
    sb_preconditioner *precond;
    sb_pcg_workspace pcg;
    sbi_assembly assembly;
    void *memory;                /* the one block behind the arrays below and in assembly */
    int material_count;          /* one per region of the mesh */
    int *material_regions;       /* [material_count] ascending region numbers */
    sb_material *materials;      /* [material_count] */
    int *cell_material;          /* [cell_count] */
    sb_real force_unit;          /* stiffness times volume over size (N): times epsilon, rounding in the forces */
    int component_count;         /* connected parts */
    sb_index_table element_component;
    sb_index_lists node_elements;
    int *node_component;         /* [node_count], -1: no element */

    /* settings */
    sb_mass_kind mass_kind;
    sb_integrator integrator;
    sb_vec3 gravity;
    sb_real damping_mass, damping_stiffness;
    sb_real tolerance, newton_tolerance;
    int max_iterations, max_newton;

    /* mass */
    sb_real *lumped_mass;        /* [node_count] (kg) */
    sb_real *mass_blocks;        /* [block_count] (kg) scalar mass of each matrix block, or NULL: lumped */
    sb_real *load_mass;          /* [node_count] (kg) int rho N dV: what gravity pulls at in a static solve */

    /* supports and loads */
    unsigned char *fixed;        /* [node_count] axes as bits; unreferenced nodes always all */
    sb_vec3 *target;             /* [node_count] target displacement of fixed axes (m) */
    sb_vec3 *dead_load;          /* [node_count] forces and tractions (N) */
    int support_used;            /* blocks in the rows of nodes with fixed axes */
    int support_capacity;        /* blocks that support_blocks holds */
    sb_real (*support_blocks)[9];/* tangent rows of nodes with fixed axes, kept before they are masked */
    sb_real (*damping_blocks)[9];/* stiffness at the start of a step of several iterations, for D; or NULL */
    double (*support_grams)[36]; /* [component_count] what the supports do to rigid motions */
    sb_vec3 *component_low, *component_high; /* [component_count] bounding boxes (m) */

    /* state */
    sb_vec3 *reference;          /* [node_count] (m) */
    sb_vec3 *position, *displacement, *velocity, *acceleration;
    int acceleration_known;      /* 0: the next Newmark step solves M a = f first */
    int force_current;           /* 1: internal holds the force at displacement */

    /* vectors of a solve, [node_count] each */
    sb_vec3 *internal;           /* internal force (N) */
    sb_vec3 *external;           /* loads of the last solve (N) */
    sb_vec3 *equilibrated;       /* loads that the last static solve ended with (N) */
    sb_vec3 *residual;           /* M a + D v + internal - external */
    sb_vec3 *rhs, *increment, *reaction;
    sb_vec3 *velocity0, *acceleration0; /* v = cv (u - start) + velocity0, a likewise */
    sb_vec3 *start;              /* displacement at the start of the step */
    sb_vec3 *saved_velocity, *saved_acceleration, *saved_reaction, *saved_external, *saved_internal;
    int saved_force_current, saved_unknots;
    sbi_precond_memory saved_precond;
    sb_vec3 *converged;          /* displacement at the last converged load increment */
    sb_vec3 *work, *work2;
};

/* Tells the observer, if there is one, of a command without bytes. */
SBI_API void sbi_body_tell(sb_body *body, sbi_command_code code, int a, int b, const int *ints, size_t int_count,
                           const sb_real *reals, size_t real_count);

/* The numbers of a material but its model and count of Prony terms, for files: unpack(pack(m)) is m. */
enum { SBI_MATERIAL_MODULI = 10, SBI_MATERIAL_REALS = SBI_MATERIAL_MODULI + 2 * SB_MAX_PRONY_TERMS };
SBI_API void sbi_body_pack_material(const sb_material *material, sb_real *reals);
SBI_API sb_material sbi_body_unpack_material(int model, int prony_count, const sb_real *reals);

/* The parts of creation that loading a state needs, too. Checks: */
SBI_API sb_result sbi_body_check_settings(const sb_body_def *def, sb_error *error);
SBI_API sb_result sbi_body_check_material(const sb_material *material, int single_rotation, sb_error *error);
/* memory, which only ever grows: */
SBI_API sb_result sbi_body_reserve_damping(sb_body *body, const sb_material *materials, int count, sb_error *error);
SBI_API sb_result sbi_body_reserve_support_blocks(sb_body *body, int needed);
/* and what follows from the materials. */
SBI_API void sbi_body_materials_changed(sb_body *body);

/* Recomputes masses after a density changed. */
SBI_API void sbi_body_update_mass(sb_body *body);
/* out = M x for the body's mass matrix. */
SBI_API void sbi_body_mass_multiply(const sb_body *body, const sb_vec3 *x, sb_vec3 *out);
/* matrix += factor * M */
SBI_API void sbi_body_add_mass(sb_body *body, sb_real factor);
/* Newton iterations of a time step, SB_AUTO resolved. */
SBI_API int sbi_body_max_newton(const sb_body *body);
/* The components of `value` on the given axes (bits), of `otherwise` on the others. */
SBI_API sb_vec3 sbi_body_pick_axes(unsigned axes, sb_vec3 value, sb_vec3 otherwise);
/* position = reference + displacement */
SBI_API void sbi_body_update_positions(sb_body *body);
/* A node of the first connected part whose supports leave a rigid motion free, or -1. */
SBI_API int sbi_body_unsupported_node(const sb_body *body);

#endif /* SB_BODY_STATE_H */
