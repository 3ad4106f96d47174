/* constraint: linear equations among displacements, and faces of two meshes tied together. Floor 3.
 *
 * Constraints hold exactly: each eliminates one degree of freedom, its slave, from the system that steps and static
 * solves solve; no penalty and no multiplier changes the conditioning of it. They live on displacements, not on
 * positions. All that stepping needs is made when constraints are added or removed, which costs about as much as
 * creating the body's matrix and preconditioner again: hand many over in one call. */
#ifndef SB_CONSTRAINT_H
#define SB_CONSTRAINT_H

#include "body.h"

/* coefficient * (displacement of the node along the axis). */
typedef struct sb_constraint_term {
    int node;
    int axis; /* 0 x, 1 y, 2 z */
    sb_real coefficient;
} sb_constraint_term;

/* Adds the equation sum_k coefficient_k u[node_k].axis_k = value (m). The first term is the slave: its displacement
 * follows from the others, as in Abaqus' *EQUATION, so its coefficient must not be 0 (nor so small beside the others
 * that a quotient overflows).
 *   terms[count]  count >= 1; other terms may name supported nodes (the slave follows), nodes of no element (as
 *                 prescribed reference nodes) and slaves of other constraints (chains are resolved)
 *   id            receives the constraint's number, >= 0, never used again by this body; may be NULL
 * A gap that a new constraint finds open is closed like the way of a moving support: at once by a time step, by load
 * increments in a static solve. A slave's velocity becomes that of its masters.
 * Errors, with nothing changed: SB_ERROR_INDEX (a node), SB_ERROR_ARGUMENT (an axis; a slave that is supported, as
 * nodes of no element always are, the slave of another constraint, among its own masters, or in a circle of
 * constraints; node and axis named), SB_ERROR_NOT_FINITE, SB_ERROR_MEMORY. A constraint with m master nodes couples
 * them all: m^2 matrix blocks. */
SB_API sb_result sb_body_add_constraint(sb_body *body, const sb_constraint_term *terms, int count, sb_real value,
                                        int *id, sb_error *error);
/* Adds `count` constraints at once, all or none: constraint c has the next term_counts[c] of `terms` and values[c]
 * (values NULL: all 0). They get the numbers *first_id, *first_id + 1, ... (first_id may be NULL). */
SB_API sb_result sb_body_add_constraints(sb_body *body, const sb_constraint_term *terms, const int *term_counts,
                                         const sb_real *values, int count, int *first_id, sb_error *error);
/* Changes the right-hand side (m) of one constraint; the next step or solve moves its slave there. Allocates nothing.
 * SB_ERROR_INDEX: there is no such constraint; SB_ERROR_NOT_FINITE. */
SB_API sb_result sb_body_set_constraint_value(sb_body *body, int id, sb_real value);
/* Removes the constraints first_id .. first_id + count - 1. SB_ERROR_INDEX when one of them does not exist,
 * SB_ERROR_MEMORY: nothing removed. */
SB_API sb_result sb_body_remove_constraints(sb_body *body, int first_id, int count, sb_error *error);
SB_API sb_result sb_body_remove_constraint(sb_body *body, int id, sb_error *error);
/* Removes all; cannot fail. */
SB_API void sb_body_clear_constraints(sb_body *body);
SB_API int sb_body_constraint_count(const sb_body *body);

/* Force of a constraint in the last step or static solve, its Lagrange multiplier (N per unit of coefficient): the
 * constraint pushes node_k along axis_k with *force * coefficient_k. sb_body_reactions at supported masters include
 * what their slaves pass on. SB_ERROR_INDEX leaves *force untouched. */
SB_API sb_result sb_body_constraint_force(const sb_body *body, int id, sb_real *force);

/* Options of sb_body_tie_faces, to be added. */
enum {
    SB_TIE_CLOSE_GAPS = 1, /* pull the slave nodes onto the faces (stress from closing); otherwise gaps stay */
    SB_TIE_ALL = 2         /* a slave node too far from all faces is an error; otherwise it is left free */
};

/* What a call of sb_body_tie_faces tied. Its constraints are first_constraint .. + constraint_count - 1. */
typedef struct sb_tie_report {
    int tied_count;      /* slave nodes tied */
    int free_count;      /* slave nodes left free: too far from all faces */
    int farthest_node;   /* the farthest of them, or -1 */
    int supported_count; /* slave nodes with supported axes; those axes are left to their supports (nodes of no
                          * element count here: none of their axes is tied) */
    sb_real largest_gap; /* of the nodes tied (m) */
    int first_constraint, constraint_count;
} sb_tie_report;

/* Ties slave nodes to faces: each to the closest point of the present shape of all faces, u_s = sum_a N_a u_a + c with
 * the face's shape functions there, along every axis that is not supported. To tie two meshes, put them in one body
 * (sb_mesh_append) and let the finer or softer side be the slave.
 *   faces         [face_count][corners]: corner nodes of element faces in any order, corners 3 (tet) or 4 (hex)
 *   slave_nodes   [slave_count], different, none on the faces, none a slave already
 *   max_distance  (m) nodes further away are left free; negative: a tenth of the closest face's diameter
 *   options       sum of SB_TIE_..., 0: keep gaps, leave far nodes free
 *   report        may be NULL
 * c keeps each node's offset from the face as it is now, so that tying causes no stress by itself.
 * What holds: slaves reproduce every displacement field that is linear in space exactly when gaps are 0, on flat and
 * curved faces, and forces balance. Constant stress passes exactly across matching faces and where the slaves' grid
 * refines the masters' (faces inside faces); else a node-to-surface tie leaves an error that falls with the element
 * size, unless the interface carries no traction. Offsets do not turn with the faces: torque balances only for gaps
 * of 0.
 * Errors, with nothing changed: those of sb_body_add_constraint; SB_ERROR_ARGUMENT names the first face that no
 * element has, or a node of both sides. Time O(slaves * faces), cheap each; memory during the call. */
SB_API sb_result sb_body_tie_faces(sb_body *body, const int *faces, int face_count, int corners, const int *slave_nodes,
                                   int slave_count, sb_real max_distance, int options, sb_tie_report *report,
                                   sb_error *error);

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* Number that tells equations apart (ids, terms, coefficients; not values): 0 without constraints. */
SBI_API uint64_t sbi_constraint_signature(const sb_body *body);
/* velocity0 and acceleration0 of slaves, so that they keep to their masters and gaps close evenly. Velocities
 * balance at `level` of the step, accelerations at `inertia` of it (1 but for generalised alpha). */
SBI_API void sbi_constraint_scheme(sb_body *body, sb_real cv, sb_real ca, sb_real dt, sb_real level, sb_real inertia);
/* Condenses the residual's reactions: multipliers, and body->reaction from the force that everything but supports and
 * constraints leaves over at each node. `out_of_balance` is overwritten. */
SBI_API void sbi_constraint_reactions(sb_body *body, sb_vec3 *out_of_balance);
/* One entry of T in the row of a slave axis. */
typedef struct sbi_constraint_entry {
    int dof; /* 3 node + axis of the master */
    sb_real weight;
    int is_free; /* 1: the weight is not 0 and the master's axis is not supported */
} sbi_constraint_entry;
/* Entry `k` of the row of (node, axis), from 0; returns 0 past the end. */
SBI_API int sbi_constraint_entry_of(const sb_body *body, int node, int axis, int k, sbi_constraint_entry *entry);
/* Whether the rows of T^T M T can be lumped: a slave with several free masters needs weights >= 0 for positive masses.
 * SB_ERROR_UNSUPPORTED names node and axis. */
SBI_API sb_result sbi_constraint_explicit_check(const sb_body *body, sb_error *error);
/* elimination->reduced = lumped mass of every axis (kg), slaves' handed to their free masters (row sums of T^T M T);
 * 0 on supported and slave axes. */
SBI_API void sbi_constraint_masses(sb_body *body);
/* Accelerations from forces [node_count] (N) with these masses: slaves hand their force on and follow, by
 * elimination->gap (m/s^2) ahead of their masters with_gaps. Supported axes of `acceleration` are given, the others are
 * written. Call after sbi_constraint_explicit_check; positions then follow by sbi_elimination_follow. No allocation. */
SBI_API void sbi_constraint_explicit(sb_body *body, const sb_vec3 *force, sb_vec3 *acceleration, int with_gaps);
/* elimination->gap = the acceleration (m/s^2) at which gaps get the rate to close evenly in dt. */
SBI_API void sbi_constraint_gap_rates(sb_body *body, sb_real dt);
/* v of slaves = that of their masters + share of the gaps that the step began with: with 1/dt velocities in a step of
 * dt, with h/dt ways in a part h of it. */
SBI_API void sbi_constraint_follow(const sb_body *body, sb_vec3 *v, sb_real share);
/* What the motion of the lumped masses of slaves has (J) beyond the sum of m v^2/2: a lumped slave's mass moves with
 * each of its masters. */
SBI_API double sbi_constraint_lumped_energy(const sb_body *body, const sb_vec3 *v);
#endif

#endif /* SB_CONSTRAINT_H */
