/* load: forces on a body: dead loads, follower pressure, springs, penalty mappings. Floor 3. */
#ifndef SB_LOAD_H
#define SB_LOAD_H

#include "body.h"

/* ---- dead loads: stay as they are until cleared ---- */
/* Adds forces[count] (N), or one for all when uniform is 1, to the nodes. SB_ERROR_NOT_FINITE; SB_ERROR_INDEX: a node
 * out of range, or a force other than 0 on a node of no element, which is held and would feel nothing. Nothing is added
 * then, and error (NULL is fine) names the node. */
SB_API sb_result sb_body_apply_forces(sb_body *body, const int *nodes, int count, const sb_vec3 *forces, int uniform,
                                      sb_error *error);
/* The same without an error, as earlier versions had it. */
SB_API sb_result sb_body_add_forces(sb_body *body, const int *nodes, int count, const sb_vec3 *forces, int uniform);
/* Adds a traction (Pa on undeformed area) on element faces, each given by its 3 (tet) or 4 (hex) corner nodes in
 * any order: faces[face_count][corners]. SB_ERROR_ARGUMENT names the first face that no element has. */
SB_API sb_result sb_body_add_traction(sb_body *body, const int *faces, int face_count, int corners, sb_vec3 traction,
                                      sb_error *error);
SB_API void sb_body_clear_loads(sb_body *body); /* forces and tractions; gravity and the loads below stay */

/* ---- loads that follow the body ----
 * Each adder makes one load and gives it an id (> 0, never used again; the place for it may be NULL), which the
 * functions below take: they return
 * SB_ERROR_INDEX for one that is not there or is of another kind. Adders copy their arrays, may allocate, and change
 * nothing on failure; changing a load between steps allocates nothing. Both statics and dynamics solve for the force
 * at the new shape (generalised alpha where it has its balance, and the readings below are of there; explicit steps
 * take it as it is). A time step has the present values of loads throughout. A static solve goes evenly from the
 * values (pressure, stiffness, points) that the last one ended with to the present ones; a load that is new to it
 * starts from no force.
 *
 * Steps and Newton. Springs and mappings have an exact positive semidefinite tangent, which every step uses: stiff
 * ones are safe at any dt. The tangent of a pressure has no sign. It is part of the exact tangent, made symmetric
 * (which only drops terms at the open rim of a patch), and left out of projected tangents and of linearised steps
 * (max_newton 1): these must stay positive definite, and treat pressure as it was at the start of the step. The work of
 * a pressure has no bound while that of a corotated material only grows with the square of the stretch: with more than
 * about a fifth of Young's modulus, such a body that something tears at may swell without end. */

/* Pressure (Pa on the deformed area; positive pushes inwards, along the present normal) on faces of the surface, given
 * as for sb_body_add_traction. SB_ERROR_INDEX and SB_ERROR_ARGUMENT name the first face with a node that the mesh does
 * not have, that no element has, or that lies between two elements; SB_ERROR_NOT_FINITE. f_a = -p int N_a x_r x x_s. */
SB_API sb_result sb_body_add_pressure(sb_body *body, const int *faces, int face_count, int corners, sb_real pressure,
                                      int *load_id, sb_error *error);
SB_API sb_result sb_body_set_pressure(sb_body *body, int load_id, sb_real pressure);

/* Springs of rest length 0 from nodes[count] to points in space points[count] (m): each pulls its node with
 * stiffness (point - position). stiffness: N/m, >= 0, one for each spring, or one for all when uniform is 1.
 * SB_ERROR_INDEX: a node out of range or of no element. */
SB_API sb_result sb_body_add_springs(sb_body *body, const int *nodes, int count, const sb_real *stiffness, int uniform,
                                     const sb_vec3 *points, int *load_id, sb_error *error);
SB_API sb_result sb_body_move_springs(sb_body *body, int load_id, const sb_vec3 *points);
SB_API sb_result sb_body_set_spring_stiffness(sb_body *body, int load_id, const sb_real *stiffness, int uniform);

/* Penalty displacements: draws each row of the mapping to targets[row_count] (m, in space) with stiffness[row_count]
 * (N/m, >= 0; one for all when uniform is 1): f = -H k (H^T x - y), K = H k H^T. A row that couples nodes without a
 * common element enlarges the body's tangent: its matrix and preconditioner are then made anew, and blocks grow with
 * the square of the row's length. SB_ERROR_ARGUMENT (an empty or descending row), SB_ERROR_INDEX (a node out of range,
 * or one of no element whose weight is not 0) and SB_ERROR_NOT_FINITE name the row (error->element) or its node.
 * Source: Robin condition through a mapping. */
SB_API sb_result sb_body_add_mapping(sb_body *body, const sb_mapping *mapping, const sb_real *stiffness, int uniform,
                                     const sb_vec3 *targets, int *load_id, sb_error *error);
SB_API sb_result sb_body_set_mapping_targets(sb_body *body, int load_id, const sb_vec3 *targets);
SB_API sb_result sb_body_set_mapping_stiffness(sb_body *body, int load_id, const sb_real *stiffness, int uniform);
/* Where the rows are now (m): points[row_count]. */
SB_API sb_result sb_body_mapping_points(const sb_body *body, int load_id, sb_vec3 *points);

/* Takes a pressure, springs, a mapping, a cable, a membrane or a cavity away; its id is then unknown. The next static
 * solve lets its force fade. */
SB_API sb_result sb_body_remove_load(sb_body *body, int load_id);

/* ---- readings of the last step or static solve: 0 before the first, no allocation ---- */
/* Net force (N) of a load on the body, and its torque (N m) about a point (m); either place may be NULL. */
SB_API sb_result sb_body_load_force(const sb_body *body, int load_id, sb_vec3 about, sb_vec3 *force, sb_vec3 *torque);
/* Force (N) of each spring on its node, forces[count], and of each row on the body, forces[row_count]. */
SB_API sb_result sb_body_spring_forces(const sb_body *body, int load_id, sb_vec3 *forces);
SB_API sb_result sb_body_mapping_forces(const sb_body *body, int load_id, sb_vec3 *forces);

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* Work of these loads along u + s du, s in [0, t]: linear t + quadratic t^2 + cubic t^3. Exact: a pressure is
 * quadratic in u, springs linear. That of cables and membranes is no polynomial: it comes from sbi_loads_curved_energy,
 * and `curved` t is what it is near u. */
typedef struct sbi_loads_work {
    sb_real linear, quadratic, cubic, curved;
} sbi_loads_work;

/* In all of these `factor` is the share of the way from the values of the last static solve to the present ones. */
/* Has the owners of potentials fill their rows at u: before the two below. */
SBI_API void sbi_loads_fill(sb_body *body, const sb_vec3 *u);
/* body->follower = their forces at u (N). Returns the size of the numbers they are differences of: times epsilon, the
 * rounding error of the follower's norm. */
SBI_API sb_real sbi_loads_force(sb_body *body, const sb_vec3 *u, sb_real factor);
/* matrix += their stiffness -df/du at u; that of pressures for SB_TANGENT_EXACT only. */
SBI_API void sbi_loads_add_tangent(sb_body *body, const sb_vec3 *u, sb_tangent_kind kind, sb_real factor,
                                   sb_matrix *matrix);
/* matrix += what cables that are slack at u, or in their toe, and membranes that wrinkle would add were they taut: a
 * bound of what may come. */
SBI_API void sbi_loads_add_slack(sb_body *body, const sb_vec3 *u, sb_matrix *matrix);
/* out -= K x with the stiffness of springs, mappings, membranes and cables (where they were laid last), which is what
 * sbi_loads_add_tangent added for linearised steps. */
SBI_API void sbi_loads_subtract_product(const sb_body *body, const sb_vec3 *x, sb_real factor, sb_vec3 *out);
/* 1 when all of them are springs, mappings and potentials: their stiffness is one of rows of weights. */
SBI_API int sbi_loads_are_rows(const sb_body *body);
/* diagonal [node_count] += the mean of the three diagonal entries of that stiffness at each node. */
SBI_API void sbi_loads_add_diagonal(const sb_body *body, sb_real factor, sb_real *diagonal);
/* 1 where a pressure is not 0. */
SBI_API int sbi_loads_press(const sb_body *body);
/* out += factor S x with the part S of the present pressures' stiffness that sbi_loads_add_tangent leaves out: it is
 * antisymmetric, and sums to what is along the open rims of their faces. */
SBI_API void sbi_loads_add_skew(const sb_body *body, const sb_vec3 *u, const sb_vec3 *x, sb_real factor, sb_vec3 *out);
/* The load with this id, or NULL. */
SBI_API const struct sbi_load *sbi_loads_get(const sb_body *body, int id);
/* out += the force (N) that a pressure load exerts at u when it is 1 Pa. */
SBI_API void sbi_load_add_unit_pressure(const sb_body *body, const struct sbi_load *load, const sb_vec3 *u,
                                        sb_vec3 *out);
/* out += H f of one row. */
SBI_API void sbi_load_spread_row(const struct sbi_load *load, int row, sb_vec3 f, sb_vec3 *out);
SBI_API sbi_loads_work sbi_loads_line(sb_body *body, const sb_vec3 *u, const sb_vec3 *du, sb_real factor);
/* Energy of cables and membranes at u (J), which is part of what a step goes down. */
SBI_API double sbi_loads_curved_energy(sb_body *body, const sb_vec3 *u, sb_real factor);
/* Energy of springs, mappings, cables and membranes at u (J), and how much of it at the body's displacement, which is
 * where the last step ended, is new since: their points or stiffness were changed. */
SBI_API double sbi_loads_energy(sb_body *body, const sb_vec3 *u);
SBI_API double sbi_loads_new_energy(sb_body *body);
/* Of cavities whose volume is held: 1, there is one; how stiff they are in the solve to come, whose matrix at u is
 * there (uses body->work and work2; renew 0: of those that have not been in one; mass: its
 * factor in the matrix, 1/s^2); they hold what they press with at u, and the largest error of a volume is
 * returned, over it. */
SBI_API int sbi_loads_are_stiff(const sb_body *body);
SBI_API void sbi_loads_stiffen(sb_body *body, const sb_vec3 *u, sb_real factor, int renew, sb_real mass);
SBI_API double sbi_loads_hold_volumes(sb_body *body, const sb_vec3 *u, sb_real factor);
/* Start of a static solve: loads that are new to it begin where they exert no force. */
SBI_API void sbi_loads_begin_static(sb_body *body);
/* A static solve ended at this factor: the next one starts from these values. */
SBI_API void sbi_loads_end_static(sb_body *body, sb_real factor);
/* End of a solve: keeps the readings and adds the forces to body->external. Springs and mappings act at the
 * displacement row_u of the balance, whose positions are the arms of torques too; pressures at pressure_u (a
 * linearised step's is the one it started from). */
SBI_API void sbi_loads_commit(sb_body *body, const sb_vec3 *row_u, const sb_vec3 *pressure_u, sb_real factor,
                              int dynamic);
#endif

#endif /* SB_LOAD_H */
