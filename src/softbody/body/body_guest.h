/* body_guest: what registration, needles and contact may read of a body, and do to it, beyond the public calls. Floor
 * 3, internal. What they do to a body is recorded, and replays to the last bit without them. */
#ifndef SB_BODY_GUEST_H
#define SB_BODY_GUEST_H

#include "../base/mapping.h"
#include "../solve/direct.h"
#include "body.h"
#include "live_mesh.h"
#include "step_parts.h"

/* ---- readings ---- */
SBI_API sb_mesh sbi_body_mesh(const sb_body *body);  /* at rest; borrowed, free cells among the others */
SBI_API sb_mesh sbi_body_shape(const sb_body *body); /* as it is now; borrowed, free cells among the others */
/* A mesh at rest with the body's nodes and its elements in use, of cells that are parts of one (sb_mixture) the first;
 * free nodes belong to no cell and lie on one that does. Release with sb_mesh_free. SB_ERROR_MEMORY. */
SBI_API sb_result sbi_body_copy_mesh(const sb_body *body, const sb_allocator *allocator, sb_mesh *mesh,
                                     sb_error *error);
/* Which cells its elements are, ascending: cells[elements]. */
SBI_API void sbi_body_list_cells(const sb_body *body, int *cells);
/* The same of the mesh before any cut, which `owner` knows (sbi_body_has_uncut), with its nodes as the body has them;
 * cells[count], to be freed: numbers that its elements had as cells. SB_ERROR_MEMORY, SB_ERROR_STATE: the body has
 * fewer nodes. */
SBI_API sb_result sbi_body_copy_uncut(const sb_body *body, const sb_body *owner, const sb_allocator *allocator,
                                      sb_mesh *mesh, int **cells, sb_error *error);
SBI_API int sbi_body_has_uncut(const sb_body *owner);
/* SB_ERROR_STATE unless the body's mesh is what it was when sb_body_mesh_version gave `version`. For those that do not
 * follow a change of the mesh, before they use what they know of it. */
SBI_API sb_result sbi_body_check_version(const sb_body *body, int version, sb_error *error);
SBI_API const sb_jobs *sbi_body_jobs(const sb_body *body);
SBI_API const sb_allocator *sbi_body_allocator(const sb_body *body);
SBI_API double sbi_body_now(const sb_body *body);      /* on its clock (s); 0 without one */
SBI_API int sbi_body_is_implicit(const sb_body *body); /* 1: its steps solve systems, and can have guests */
/* Takes beforehand what steps need with a guest of so many unknowns that takes so many nodes, while the mesh keeps to
 * its slack. SB_ERROR_MEMORY changes nothing. */
SBI_API sb_result sbi_body_reserve_guest(sb_body *body, int unknowns, int nodes, sb_error *error);
SBI_API int sbi_body_has_constraints(const sb_body *body);
SBI_API int sbi_body_has_pieces(const sb_body *body); /* 1: cells of it are pieces of elements, as a cut leaves them */
SBI_API int sbi_body_is_live(const sb_body *body);    /* 1: its mesh can change */
SBI_API int sbi_body_has_finder(const sb_body *body); /* 1: an sb_cut knows which piece has what material */
/* sb_body_find_cell for an element of `mesh`, which has been `cell` of the body; -1 where the material at xi was taken
 * out, though its slot may be another's now. */
SBI_API int sbi_body_find_holder(const sb_body *body, const sb_mesh *mesh, int element, int cell, const sb_real xi[3]);
SBI_API int sbi_body_load_count(const sb_body *body); /* pressures, springs and mappings */
SBI_API int sbi_body_max_iterations(const sb_body *body);
SBI_API const sb_vec3 *
sbi_body_targets(const sb_body *body);               /* [nodes] where fixed axes are to be: displacements (m) */
SBI_API sb_real sbi_body_young(const sb_body *body); /* Young's modulus (Pa), mean over the elements */
/* The components of `value` on the given axes (bits), of `otherwise` on the others. */
SBI_API sb_vec3 sbi_body_pick_axes(unsigned axes, sb_vec3 value, sb_vec3 otherwise);

/* ---- slots of a mesh that may change ---- */
typedef struct sbi_body_slots {
    int end;         /* slots in use and free ones lie below; the next one after the free ones */
    int room;        /* slots there is memory for; 0: the mesh cannot change */
    const int *free; /* [free_count] free slots, the last of them the next to be used */
    int free_count;
} sbi_body_slots;
SBI_API sbi_body_slots sbi_body_node_slots(const sb_body *body);
SBI_API sbi_body_slots sbi_body_cell_slots(const sb_body *body);
SBI_API int sbi_body_cell_region(const sb_body *body, int cell);                  /* value in mesh.regions */
SBI_API const sb_material *sbi_body_cell_material(const sb_body *body, int cell); /* of a cell in use */

/* ---- parts of elements, as an sb_mixture has them: cells side by side with the same nodes ---- */
/* Young's modulus (Pa) and Poisson's ratio. */
typedef struct sbi_body_modulus {
    double young, poisson;
} sbi_body_modulus;
SBI_API int sbi_body_is_later_part(const sb_body *body, int cell); /* 1: of an element that the cell before it is of */
SBI_API int sbi_body_part_count(const sb_body *body, int cell); /* from a first part on; 1: it is all of an element */
SBI_API double sbi_body_part_share(const sb_body *body, int cell, int part); /* of the element's volume */
/* Of the element of a first part in use, as its parts have it together. */
SBI_API sbi_body_modulus sbi_body_cell_modulus(const sb_body *body, int cell);

/* ---- shapes ---- */
/* Elastic energy (J) of a shape. Returns -1, or the first element that its material does not admit. */
SBI_API int sbi_body_try_shape(sb_body *body, const sb_vec3 *u, sb_real *energy);
/* Moves the body to displacements u[nodes] (m), finite, like sb_body_set_displacements, from a shape whose forces were
 * asked for by one of the calls below. */
SBI_API void sbi_body_place(sb_body *body, const sb_vec3 *u);

/* ---- forces and stiffness at the present shape, with the tangent SB_TANGENT_QUASI ---- */
/* A place for the factor of the body's tangent. */
SBI_API sb_result sbi_body_make_factor(const sb_body *body, const sb_allocator *allocator, sb_direct **factor,
                                       sb_error *error);
/* residual[nodes] (N) = internal forces less gravity and dead loads; factor: that of the tangent and a mass that holds
 * what nothing holds, `hold` (N/m) in all, with identity rows for fixed axes. SB_ERROR_INVERTED and the factor's. */
SBI_API sb_result sbi_body_factor(sb_body *body, sb_real hold, sb_vec3 *residual, sb_direct *factor, sb_error *error);

/* ---- a load from outside ---- */
/* Rows, each a point of weighted nodes that elements couple already, that an owner fills: at a displacement u the force
 * (N) on the point, its stiffness k (N/m, >= 0) and line l, of at most unit length: the stiffness is k [(1 - l.l) I + l
 * l^T]. Called once for each residual, by one thread; what it writes must not depend on threads. */
typedef struct sbi_potential sbi_potential;
typedef void (*sbi_potential_fill)(void *user, const sb_vec3 *u, sb_vec3 *force, sb_real *stiffness, sb_vec3 *lines);
/* rows are copied. The body does not have the load until it is lent, but room for it. */
SBI_API sb_result sbi_potential_create(sb_body *body, const sb_mapping *rows, sbi_potential_fill fill, void *user,
                                       const sb_allocator *allocator, sbi_potential **potential, sb_error *error);
SBI_API void sbi_potential_destroy(sbi_potential *potential);
/* The body has the load, last, until it is returned. Nothing may be added in between. Allocates only where other loads
 * took the room. */
SBI_API sb_result sbi_potential_lend(sb_body *body, const sbi_potential *potential, sb_error *error);
SBI_API void sbi_potential_return(sb_body *body, sbi_potential *potential);
/* One linear system towards the equilibrium of present loads, supports and the potential, held like sbi_body_factor;
 * the linear tolerance is relative. Afterwards, also when it failed, sbi_relax_end must be called; in between
 * sbi_step_solve solves for sbi_relax_increment. Not for bodies with constraints. */
SBI_API sb_result sbi_relax_begin(sb_body *body, sbi_potential *potential, sb_real hold, sb_real tolerance,
                                  sb_step_info *info, sbi_step *step);
SBI_API sb_vec3 *sbi_relax_increment(const sbi_step *step); /* [nodes] (m); may be changed */
/* Places the body at u, or, NULL, leaves it as it was to the last bit. */
SBI_API void sbi_relax_end(sbi_step *step, sbi_potential *potential, const sb_vec3 *u);
/* Makes rows of a mapping softer along the surface: lines[rows] as above; NULL: no longer. SB_ERROR_INDEX,
 * SB_ERROR_NOT_FINITE, SB_ERROR_MEMORY change nothing. */
SBI_API sb_result sbi_body_set_mapping_lines(sb_body *body, int load_id, const sb_vec3 *lines);
/* The memory for that, so that it cannot fail for lack of it. */
SBI_API sb_result sbi_body_reserve_mapping_lines(sb_body *body, int load_id);

#endif /* SB_BODY_GUEST_H */
