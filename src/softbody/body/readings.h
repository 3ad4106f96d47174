/* readings: tensors and energies of a body by point, element and node, for plots, colours and criteria. Floor 3.
 *
 * All read the present state and allocate nothing. Principal values and directions of any of these symmetric tensors:
 * sb_m3_eigen; von Mises stress: sb_von_mises. Stresses include what fibres and Prony terms add. */
#ifndef SB_READINGS_H
#define SB_READINGS_H

#include "body.h"

typedef enum sb_tensor {
    SB_TENSOR_STRESS = 1, /* Cauchy (Pa): force per present area */
    SB_TENSOR_STRAIN = 2  /* Green-Lagrange (F^T F - I)/2, in the axes of the body at rest: a rotation has none. A
                           * principal value e is a stretch of sqrt(1 + 2 e). SB_LINEAR: sym(F) - I */
} sb_tensor;

/* Deformation gradient dx/dX at an integration point of an element, [0, sb_body_point_count). SB_ERROR_INDEX: *F is
 * untouched. */
SB_API sb_result sb_body_deformation(const sb_body *body, int element, int point, sb_mat3 *F);
/* Strain there, see SB_TENSOR_STRAIN; errors as above. (Stress: sb_body_stress.) */
SB_API sb_result sb_body_strain(const sb_body *body, int element, int point, sb_mat3 *strain);

/* A tensor at every node; values[sb_body_node_count], 0 where there is no material. In each element a linear function
 * of its local coordinates is fitted to the integration points (tet4: a constant), taken to its nodes, and averaged
 * there, weighted by volume; elements that are cut or have points of their own (sb_body_def.domain) give their mean.
 * tensor is an sb_tensor. Measured on irregular meshes
 * (tests/verification.md, verification_readings): halving elements divides errors by 3.5 of tet10, hex20 and hex27, by
 * 2.4 of tet4 and hex8 and by 1.9 at the surface, where these two know the middle of the layer below only.
 * SB_ERROR_ARGUMENT: NULL, or another tensor; SB_ERROR_INVERTED: error->element has no stress, its material does not
 * admit the state; *values is then untouched. error may be NULL. */
SB_API sb_result sb_body_nodal_tensors(const sb_body *body, int tensor, sb_mat3 *values, sb_error *error);
/* The same from the elements of one region alone, 0 at nodes of others: stresses jump where materials meet, and an
 * average over both sides is neither. SB_ERROR_INDEX: the mesh has no such region. */
SB_API sb_result sb_body_region_tensors(const sb_body *body, int region, int tensor, sb_mat3 *values, sb_error *error);

/* Elastic energy of each element per volume at rest (J/m^3), mean over the element; values[sb_body_element_count].
 * Times the volumes they sum to sb_energy.elastic, what ties pieces of a cut to each other left out; with Prony terms
 * of the long-term response, as there. SB_ERROR_ARGUMENT; SB_ERROR_INVERTED names the element; SB_ERROR_NOT_FINITE: too
 * large for sb_real; values are then untouched. error may be NULL. */
SB_API sb_result sb_body_energy_densities(sb_body *body, sb_real *values, sb_error *error);

#endif /* SB_READINGS_H */
