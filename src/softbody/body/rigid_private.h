/* rigid_private: free rigid bodies of a body, and what steps, states and changes of the mesh do with them. Internal. */
#ifndef SB_RIGID_PRIVATE_H
#define SB_RIGID_PRIVATE_H

#include "../mesh/mesh_change.h"
#include "../solve/guest.h"
#include "rigid.h"
#include "step_parts.h"

enum { SBI_RIGID_UNKNOWNS = 6 };

/* Motion, in doubles also where sb_real is float. */
typedef struct sbi_rigid_state {
    double centre[3];       /* m */
    double turn[4];         /* unit quaternion w x y z, from its frame to space */
    double velocity[3];     /* m/s */
    double acceleration[3]; /* m/s^2 */
    double spin[3];         /* rad/s, in its frame */
    double spin_rate[3];    /* rad/s^2, in its frame */
    double wrench[6];       /* N, N m about the centre: the tissue's on it, in the last step */
} sbi_rigid_state;

/* In statics, a torque t that keeps its direction: it has no potential, and what is antisymmetric in how it balances,
 * dth x t / 2, is found by solving again with what the turn of the last solve makes of it. */
enum { SBI_RIGID_SECANTS = 2 }; /* as many as it has ranks */
typedef struct sbi_rigid_skew {
    double torque[3], before[3]; /* what the rows have of it now, and a round before */
    double left[3];              /* what was missing to what came of it */
    double torques[SBI_RIGID_SECANTS][3], lefts[SBI_RIGID_SECANTS][3]; /* differences between rounds, the last first */
    int known;                                                         /* of them */
} sbi_rigid_skew;

/* The step under way. Rotations from the turn at its start are exp(th), th the last three unknowns; `start` vectors are
 * what is in its frame, turned by the turn at the start, which does not change in the step. */
typedef struct sbi_rigid_step {
    int starts;                 /* see sbi_guest_step */
    int keeps_momentum;         /* 1: of implicit Euler, R J w - (R J w)_n = dt t; else J w' + w x J w = R^T t */
    int rounds;                 /* times that it was solved on with what its turn changes */
    const sb_matrix *matrix;    /* of the system that is solved */
    double dt, level, cv, ca;   /* dt 0: statics, in an increment */
    double load[6], gravity[3]; /* N, N m; m/s^2 */
    double frame[9];            /* turn at the start */
    double inertia[9];          /* start: R J R^T */
    double spin[3];             /* start: w_n */
    double velocity0[3], acceleration0[3]; /* of the centre, see sbi_guest_step */
    double spin0[3], spin_rate0[3];        /* start */
    double at[6], left[6];                 /* unknowns that its rows are made at, and what is out of balance there */
    double slope[9];                       /* d turn / d th there: the left Jacobian of exp */
    double mass_slope[9];                  /* stiffness that its inertia has, or in statics its arms' turning (N m) */
    double factor[36], scale[6];           /* Cholesky factor of its block, whose rows and columns were scaled */
    double turning[9];                     /* and of that what its arms' turning has (N m) */
    sbi_rigid_skew skew;
    double found[6]; /* of `starts`: accelerations, start */
} sbi_rigid_step;

typedef struct sbi_rigid {
    int id;
    double mass, inertia[9];          /* kg, kg m^2 in its frame */
    double load[6];                   /* N, N m */
    double equilibrated[6];           /* N, N m: load and weight that the last static solve ended with */
    sbi_rigid_state now, saved, home; /* saved: at the start of a step; home: when it was added, at rest */
    int count, capacity;
    int *hung;        /* [count] nodes, ascending */
    double (*arm)[3]; /* [count] m, in its frame */
    void *memory;
    /* of a step: those of them that have material */
    int *active;                        /* [guest.node_count] nodes */
    double (*lever)[3];                 /* [guest.node_count] arms */
    double (*from)[3];                  /* [..] places at the start of the step (m) */
    double (*y)[3];                     /* [..] arms in space where its rows are made (m) */
    double unknown[SBI_RIGID_UNKNOWNS]; /* way of the centre (m), th (rad) */
    sbi_guest guest;
    sbi_rigid_step step;
} sbi_rigid;

typedef struct sbi_rigids {
    sbi_rigid *list[SB_MAX_RIGID]; /* [count] by ascending id */
    int count, last_id;
    int *made_on, made_capacity; /* of a change under way: index of the one that each node made is to hang on, or -1 */
} sbi_rigids;

/* ---- rigid_list.c ---- */
/* An empty one with room for so many nodes; NULL: no memory. */
SBI_API sbi_rigid *sbi_rigid_make(const sb_allocator *allocator, int capacity);
SBI_API void sbi_rigid_free(const sb_allocator *allocator, sbi_rigid *rigid);
SBI_API void sbi_rigids_free(const sb_allocator *allocator, sbi_rigids *rigids); /* NULL is fine */
/* Lists with room for so many nodes; 0: no memory. Those that there are stay. */
SBI_API int sbi_rigid_take_lists(const sb_allocator *allocator, sbi_rigid *rigid, int capacity);
SBI_API sb_result sbi_rigid_no_memory(sb_error *error, int nodes);
/* 1: a mass and an inertia. */
SBI_API int sbi_rigid_has_inertia(double mass, const double inertia[9]);
/* The rigid body that a node hangs on, or NULL. */
SBI_API const sbi_rigid *sbi_body_hung_on(const sb_body *body, int node);
/* Axes that a node is supported along, or hangs by: all. */
SBI_API int sbi_body_held_axes(const sb_body *body, int node);
/* SB_ERROR_ARGUMENT for a node that hangs: what: "supported". */
SBI_API sb_result sbi_body_check_not_hung(const sb_body *body, const int *nodes, int count, const char *what,
                                          sb_error *error);
/* SB_ERROR_UNSUPPORTED where there is one: what: "static solves". */
SBI_API sb_result sbi_body_refuse_rigids(const sb_body *body, const char *what, sb_error *error);
/* Adds what their guests have, for room. */
SBI_API void sbi_rigids_count(const sb_body *body, int *unknowns, int *nodes);
/* Back to where they were added, at rest. */
SBI_API void sbi_body_reset_rigids(sb_body *body);
/* Matrix of a unit quaternion w x y z, row-major. */
SBI_API void sbi_rigid_matrix(const double turn[4], double r[9]);
SBI_API void sbi_rigid_get(sb_vec3 v, double out[3]);
/* out = R^T v */
SBI_API void sbi_rigid_into_frame(const double turn[4], const double v[3], double out[3]);
/* Place of a node in the ascending list, or where it would stand. */
SBI_API int sbi_rigid_place_of(const sbi_rigid *rigid, int node);
/* Arm of a node as it is now. */
SBI_API void sbi_rigid_make_arm(const sb_body *body, const sbi_rigid *rigid, int node, double arm[3]);
/* A node comes to those that hang. 0: it does already, or there is no room. */
SBI_API int sbi_rigid_hang(const sb_body *body, sbi_rigid *rigid, int node);
/* A node hangs no longer. */
SBI_API void sbi_rigid_let_go(sbi_rigid *rigid, int node);

/* ---- rigid_follow.c ---- */
/* A change of the mesh is to come: room for nodes that will hang, or a refusal. Then: it has happened. */
SBI_API sb_result sbi_rigids_reserve(const sb_body *body, const sb_mesh_change *change, sb_error *error);
SBI_API void sbi_rigids_follow(sb_body *body, const sb_mesh_change *change);

/* ---- rigid_reserve.c ---- */
/* What steps need of conjugate gradients with these (NULL: none), and this matrix. */
SBI_API sb_result sbi_body_reserve_rigids(sb_body *body, sbi_rigids *rigids, const sb_matrix *matrix, sb_error *error);

/* ---- rigid_step.c ---- */
/* Its guest, which acts on these nodes. */
SBI_API void sbi_rigid_make_guest(sbi_rigid *rigid, const int *nodes, int count);
/* Its nodes with material, from where they are. SB_ERROR_UNSUPPORTED: one is supported. */
SBI_API sb_result sbi_rigid_activate(const sb_body *body, sbi_rigid *rigid, sb_error *error);
/* One that was activated, for small motions about this turn; left: forces at nodes (N) whose arms' turning counts, or
 * NULL. Then its block with this matrix and `shift` times its mass; 0: it is not positive definite. */
SBI_API void sbi_rigid_set_small(sbi_rigid *rigid, const double turn[4], const sb_vec3 *left);
SBI_API int sbi_rigid_factor_small(sbi_rigid *rigid, const sb_matrix *matrix, double shift);
/* A step begins: its guests are those of its caller, and the body's rigid bodies. SB_ERROR_UNSUPPORTED. */
SBI_API sb_result sbi_rigids_join(sbi_step *step, const sbi_guest *const **guests, int *count);
/* The step has its balance: what the tissue does to them. Uses body->work and work2. */
SBI_API void sbi_rigids_read(const sbi_step *step);
/* Its wrench, from what is left over at nodes (N) without it, the arms being those of there. */
SBI_API void sbi_rigid_read_wrench(sbi_rigid *rigid, const sb_vec3 *left);
/* turn = exp(th) turn, at unit length. */
SBI_API void sbi_rigid_turn_by(const double th[3], double turn[4]);
/* Their motion at the end of the step. SB_ERROR_DIVERGED. */
SBI_API sb_result sbi_rigids_finish(sbi_step *step);
/* Nodes that hang go to where they have them by now. */
SBI_API void sbi_rigids_place(const sb_body *body, sb_vec3 *displacement);
SBI_API void sbi_rigids_save(sb_body *body);
SBI_API void sbi_rigids_restore(sb_body *body);

/* ---- rigid_static.c: of static solves ---- */
/* The step's guests are those of the body, with their memory; before it is begun. SB_ERROR_UNSUPPORTED. */
SBI_API sb_result sbi_rigids_begin_static(sbi_step *step);
/* A load increment begins, or has its balance. */
SBI_API void sbi_rigids_begin_increment(sbi_step *step);
SBI_API void sbi_rigids_end_increment(sbi_step *step);
/* Work (J) of their loads since the solve began, in magnitude, of those in a part of the matrix; -1: of all. */
SBI_API double sbi_rigids_work(const sbi_step *step, int part);
/* The solve is done, at rest: work has what is left over at nodes. */
SBI_API void sbi_rigids_end_static(sbi_step *step);

/* ---- rigid_modes.c: vectors of [node_count + 2 rigid bodies], see there ---- */
typedef struct sbi_rigids_small {
    const sbi_guest *list[SB_MAX_RIGID];
    sbi_guests guests;
    int count;
} sbi_rigids_small;
/* Their guests for small motions, and what conjugate gradients on this matrix need. SB_ERROR_MEMORY,
 * SB_ERROR_UNSUPPORTED (see sbi_rigid_activate). */
SBI_API sb_result sbi_rigids_begin_small(sb_body *body, const sb_matrix *matrix, sbi_rigids_small *small,
                                         sb_error *error);
/* About where they are, or were added; left: see sbi_rigid_set_small. Then: systems are those of this matrix and
 * `shift` (1/s^2) times their masses. SB_ERROR_INDEFINITE. */
SBI_API void sbi_rigids_turn_small(sb_body *body, int at_present, const sb_vec3 *left);
SBI_API sb_result sbi_rigids_factor_small(sb_body *body, const sb_matrix *matrix, double shift, sb_error *error);
/* nodes that hang = where x has their rigid bodies */
SBI_API void sbi_rigids_spread(const sb_body *body, const sb_vec3 *x, sb_vec3 *nodes);
/* What nodes that hang have of f goes to their rigid bodies, which have nothing else. */
SBI_API void sbi_rigids_gather(const sb_body *body, sb_vec3 *f);
/* out += (share times their own masses + `turning` times what their arms' turning has) x */
SBI_API void sbi_rigids_add_mass(const sb_body *body, const sb_vec3 *x, double share, double turning, sb_vec3 *out);
/* weight [..] (kg) of nodes; theirs (kg, kg m^2) are those of what hangs and their own. */
SBI_API void sbi_rigids_weigh(const sb_body *body, sb_vec3 *weight);
/* Right-hand sides of a solve; and what it found. */
SBI_API void sbi_rigids_take_load(const sb_body *body, const sb_vec3 *rhs);
SBI_API void sbi_rigids_give_way(const sb_body *body, sb_vec3 *x);
/* x of them = a way (m) and a turn (rad) about a point. */
SBI_API void sbi_rigids_fill_motion(const sb_body *body, int at_present, sb_vec3 way, sb_vec3 turn, sb_vec3 about,
                                    sb_vec3 *x);
/* What they have more than the nodes that hang on them. */
SBI_API int sbi_rigids_count_freedom(const sb_body *body);

/* ---- rigid_hold.c ---- */
/* What can move freely: a part of the mesh, by one of its nodes, or a rigid body, by its id, and a node that hangs on
 * it; -1 and 0: nothing. */
typedef struct sbi_loose {
    int node, rigid;
} sbi_loose;
SBI_API sb_result sbi_body_find_loose(const sb_body *body, sbi_loose *loose, sb_error *error);
/* SB_ERROR_UNCONSTRAINED where a part of the mesh or a rigid body can move freely (error->node: of the part, or one
 * that hangs), SB_ERROR_MEMORY. */
SBI_API sb_result sbi_body_check_held(const sb_body *body, sb_error *error);

#endif /* SB_RIGID_PRIVATE_H */
