/* body_state: what is inside an sb_body. Floor 3, internal: body.c keeps it, step.c moves it. */
#ifndef SB_BODY_STATE_H
#define SB_BODY_STATE_H

#include "assembly.h"
#include "body.h"

/* What an explicit body knows of its stability; part of the state, zeros: nothing yet. */
typedef struct sbi_step_guard {
    sb_real stable_step;         /* at the last look (s) */
    int age;                     /* substeps since */
    int ledger_open;             /* 1: energy means something */
    int caution, calm;           /* plan of substeps, and calls that went well with it */
    double energy;               /* what the body has left of what it was given (J): more cannot be in its motion */
} sbi_step_guard;

struct sb_body {
    sb_allocator allocator;
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
    sb_real spectral_radius;
    int max_substeps;

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
    sbi_step_guard guard;

    /* vectors of a solve, [node_count] each */
    sb_vec3 *internal;           /* internal force (N) */
    sb_vec3 *external;           /* loads of the last solve (N) */
    sb_vec3 *equilibrated;       /* loads that the last static solve ended with (N) */
    sb_vec3 *residual;           /* M a + D v + internal - external */
    sb_vec3 *rhs, *increment, *reaction;
    sb_vec3 *velocity0, *acceleration0; /* v = cv (u - start) + velocity0, a likewise */
    sb_vec3 *start;              /* displacement at the start of the step */
    sb_vec3 *saved_velocity, *saved_acceleration, *saved_reaction, *saved_external, *saved_internal;
    int saved_force_current;
    sb_vec3 *converged;          /* displacement at the last converged load increment */
    sb_vec3 *work, *work2;
};

/* Recomputes masses after a density changed. */
SBI_API void sbi_body_update_mass(sb_body *body);
/* blocks[block_count] (kg) = a mass matrix of any kind, one scalar per block of the pattern. */
SBI_API void sbi_body_mass_blocks(const sb_body *body, sb_mass_kind kind, sb_real *blocks);
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
