/* domain: integration points, the one abstraction everything with energy is made of. Floor 2. */
#ifndef SB_DOMAIN_H
#define SB_DOMAIN_H

#include "../base/mapping.h"
#include "../mesh/element.h"
#include "../mesh/mesh.h"
#include "../mesh/mesh_change.h"
#include "piece.h"

/* Cells of integration points. A cell is a list of nodes and the points that share it; a point is a weight (m^3)
 * and the reference gradients (1/m) of the cell's shape functions. With these
 *     F = I + sum_a u_a (x) grad N_a,   f_a += w P grad N_a,   K_ab += w grad N_a . dP/dF . grad N_b
 * serve every element, and whatever else can name its nodes, weights and gradients: a body takes a domain of one's own
 * (sb_body_def.domain). Several cells may then have the same nodes, and weights may be 0: such a point takes no part,
 * not even where its deformation is one that the material does not admit. */
typedef struct sb_domain {
    sb_element_type element_type;  /* what the cells are; lets loops run with literal counts */
    const sb_element_table *table; /* of SB_CUSTOM cells, borrowed; else NULL */
    int single_rotation;           /* 1: one rotation per cell, that of its mean deformation gradient (tet10) */
    int mean_points;               /* the last points of a cell that are means of the others (B-bar): they have their
                                    * gradients projected and together their volume, and stand for the share of the
                                    * material that resists changes of volume, which the others then leave out. 0; 1:
                                    * the mean, of hex8 and tet10; 4: linear in the cell, of hex20 and hex27 */
    int node_count;
    int cell_count;
    int nodes_per_cell;
    int points_per_cell;
    int *cells;         /* [cell_count][nodes_per_cell] */
    sb_real *gradients; /* [cell_count][points_per_cell][nodes_per_cell][3]  (1/m) */
    sb_real *weights;   /* [cell_count][points_per_cell]  (m^3) */
    sb_real *cell_mass; /* [cell_count][n (n + 1) / 2] (m^3) what stands for int N_a N_b dV of a cell, pairs a <= b
                         * row by row (n nodes per cell); NULL: the cells are elements, full of material */
    int patch_count;    /* of cell_patch; 0 without */
    int *cell_patch;    /* [cell_count] of tet4: the patch of each cell, over which the change of volume is averaged:
                         * see SB_INTEGRATION_PATCH. Cells of a patch are of one region; its unknowns are coupled as
                         * those of one cell. NULL: none */
    int cell_capacity;  /* internal: cells that the arrays have room for, where the mesh may change; otherwise 0 */
    sb_allocator allocator;
} sb_domain;

/* Most mean points of a cell. */
enum { SB_MAX_MEAN_POINTS = 4 };

/* How a domain integrates its elements. */
typedef enum sb_integration {
    SB_INTEGRATION_AUTO = 0,     /* standard; tet10 with curved sides gets the 8-point rule it needs */
    SB_INTEGRATION_STANDARD = 1, /* tet4 1, tet10 4, hex8 2x2x2, hex20 and hex27 3x3x3 points, custom its own */
    SB_INTEGRATION_CURVED = 2,   /* tet10 8 points (degree 3); other elements as standard */
    SB_INTEGRATION_BBAR = 3,     /* tet10, hex8, hex20 and hex27 that do not lock when nearly incompressible: shear at
                                  * the points of the standard rule (of a curved tet10: 8), volume at mean points, one
                                  * of tet10 and hex8 (a mean gradient B-bar, Hughes 1980, after de Souza Neto et al.
                                  * 1996 for large strains), four of hex20 and hex27 (gradients projected onto 1, xi,
                                  * eta, zeta of the cell: Simo, Taylor and Pister 1985), with an energy. Bending within
                                  * a hex8 stays as stiff as with the standard rule. A tet10's pressure is then constant
                                  * in each and its errors fall with h^2, not h^3: for nu above 0.45 only */
    SB_INTEGRATION_PATCH = 4     /* tet4 that do not lock when nearly incompressible: shear in each tet, the change of
                                  * volume averaged over disjoint patches of 5 to 10 tets that are connected by faces
                                  * and of one region (F-bar patch: de Souza Neto, Andrade Pires and Owen 2005, with an
                                  * energy). Of hexahedral cells that a generator cut, six or five tets each, one after
                                  * another in the mesh, patches are the cells. What tet4 lose in bending stays. The
                                  * matrix has some 1.7 times the blocks: for nu above 0.4 */
} sb_integration;

/* Makes the domain of a volume mesh's elements. single_rotation: 1 for tet10 with one rotation per element.
 * Fails with SB_ERROR_MESH naming the element when a Jacobian at an integration point is not positive,
 * SB_ERROR_NOT_FINITE or SB_ERROR_INDEX naming the node, SB_ERROR_ARGUMENT for a surface mesh, single_rotation or
 * SB_INTEGRATION_BBAR on another element, or both together, SB_INTEGRATION_PATCH on another than tet4,
 * SB_ERROR_UNSUPPORTED for an element that SB_ELEMENT left out, SB_ERROR_MEMORY; *domain is then untouched. Release
 * with sb_domain_free. Source: formula of the isoparametric map, g_a = Je^-T dN_a/dxi. */
SB_API sb_result sb_domain_create(const sb_mesh *mesh, sb_integration integration, int single_rotation,
                                  const sb_allocator *allocator, sb_domain *domain, sb_error *error);

/* Releases the arrays and leaves zeros; {0} and NULL are fine. */
SB_API void sb_domain_free(sb_domain *domain);

/* Mass matrices of an element at unit density. */
typedef enum sb_mass_kind {
    SB_MASS_LUMPED = 0, /* diagonal, positive: HRZ scaling of the consistent diagonal (Hinton et al. 1976). Where cells
                         * have masses of their own (cell_mass), no node gets less than half of what it would have
                         * of cells as full as their stiffness, so that explicit steps stay nearly as long as in
                         * full cells however little of one is inside; the mass of each part of the body stays what
                         * it is, and where any node was given more its centre is made exact. Clouds are scaled only */
    SB_MASS_CONSISTENT = 1, /* int N_a N_b dV, integrated exactly */
    SB_MASS_REDUCED = 2     /* int N_a N_b dV with the points of the stiffness, as some industrial solvers do. Of low
                             * rank on tets: for comparisons, with supports */
} sb_mass_kind;

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* Deep copy of a domain of the mesh's elements, after checks: SB_ERROR_ARGUMENT where it does not fit the mesh, has a
 * NULL array, other numbers of points than a body's loops, a negative weight or mass, no weight at all, or gradients
 * that do not sum to 0; SB_ERROR_NOT_FINITE; both name the cell; and what sb_domain_create returns. *copy is untouched
 * on failure. */
SBI_API sb_result sbi_domain_copy(const sb_domain *domain, const sb_mesh *mesh, const sb_allocator *allocator,
                                  sb_domain *copy, sb_error *error);
/* Fills weights and gradients of every cell; the arrays are there, cells, counts and mean_points set.
 * positions  [node_count] (m)
 * shares     [cell_count] that the weights are multiplied by; all of a cell is 0 where it is free. NULL: 1
 * pieces     [cell_count] of tet4 and tet10; NULL: none
 * SB_ERROR_MESH names the element, SB_ERROR_UNSUPPORTED one that is a piece of a tet10 with curved sides. */
SBI_API sb_result sbi_domain_fill(sb_domain *domain, sb_quadrature_kind kind, const sb_vec3 *positions,
                                  const sb_real *shares, const sbi_piece *pieces, sb_error *error);
/* Volume of the tet of a cell's corners (m^3). */
SBI_API sb_real sbi_domain_tet_volume(const sb_vec3 x[4]);
/* ---- a mesh that changes: tet4 only. A slot that holds no cell names node 0 at every corner and
 * has weight and gradients of 0, so that loops that only read need not know. */

/* Room for so many cells; SB_ERROR_UNSUPPORTED for other cells than tet4 with their own mass, SB_ERROR_MEMORY: nothing
 * has changed. */
SBI_API sb_result sbi_domain_make_live(sb_domain *domain, int cell_capacity, sb_error *error);
SBI_API sb_result sbi_domain_reserve(sb_domain *domain, const sbi_mesh_change *change, sb_error *error);
/* Cells and rest shapes after the change; positions [change->node_end] at rest (m), of cells with positive volumes. */
SBI_API void sbi_domain_follow(sb_domain *domain, const sbi_mesh_change *change, const sb_vec3 *positions);
/* SB_ERROR_UNSUPPORTED names a tet10 with curved sides, which cannot be a piece of an element. */
SBI_API sb_result sbi_domain_check_straight(const sb_domain *domain, const sb_vec3 *positions, sb_error *error);
/* What shapes and masses of tet4 take from their quadrature rules, worked out once for many cells. */
typedef struct sbi_tet_rule {
    int count; /* points of the mass */
    sb_real weights[SB_MAX_QUADRATURE_POINTS], shapes[SB_MAX_QUADRATURE_POINTS][4];
    sb_real slopes[4][3]; /* local gradients, the same at all points */
    sb_real volume;       /* weight of the one point of the stiffness */
} sbi_tet_rule;
/* 1 when a share of a tet with corners at x has a volume, as sbi_domain_fill wants it; of a piece the tet. */
SBI_API int sbi_domain_is_upright(const sbi_tet_rule *rule, const sb_vec3 x[4], sb_real share, int is_piece);
/* The same of cell e, with the error of sbi_domain_fill. */
SBI_API sb_result sbi_domain_check_tet(const sbi_tet_rule *rule, int e, const sb_vec3 x[4], sb_real share, int is_piece,
                                       sb_error *error);
/* Most points of a cell, means included. */
enum { SBI_CELL_POINTS = (int)SB_MAX_QUADRATURE_POINTS + (int)SB_MAX_MEAN_POINTS };
/* Shares of a cell's mean points in what is there at local coordinates xi: values at mean points that are linear in xi
 * are met everywhere. */
SBI_API void sbi_domain_mean_shares(int mean_points, const sb_real xi[3], sb_real shares[SB_MAX_MEAN_POINTS]);
SB_INLINE int sbi_domain_is_free(const sb_domain *domain, int cell)
{
    const int *nodes = domain->cells + (size_t)cell * (size_t)domain->nodes_per_cell;
    return nodes[0] == nodes[1];
}

/* As sbi_element_mass for a cell with nodes at x[nodes] (m); cells with a mass of their own have that, to which
 * SB_MASS_REDUCED makes no difference, and of which every node gets a share when it is lumped: returns 1 where one
 * would have had less, else 0. */
SBI_API int sbi_domain_element_mass(const sb_domain *domain, int cell, sb_mass_kind kind, const sb_vec3 *x,
                                    sb_real *mass, sb_real *volume_load);
SBI_API void sbi_domain_make_tet_rule(const sb_domain *domain, sbi_tet_rule *rule);
/* Lumped masses and int N_a dV (m^3) of a tet4 at x (m): the bits of sbi_element_mass. */
SBI_API void sbi_domain_tet_masses(const sbi_tet_rule *rule, const sb_vec3 x[4], sb_real masses[4], sb_real load[4]);
/* The least share of the mass that a node would have, were its cells full up to their stiffness, that lumping leaves it
 * with where cells have masses of their own. */
#define SBI_LEAST_MASS ((sb_real)0.5)
/* full[nodes] (m^3): the lumped mass of the cell's element with nodes at x[nodes] (m), as if it were full. */
SBI_API void sbi_domain_full_mass(const sb_domain *domain, const sb_vec3 *x, sb_real *full);
/* The element of the cells. */
SB_INLINE sbi_element sbi_domain_element(const sb_domain *domain)
{
    return sbi_element_make(domain->element_type, domain->table);
}
SB_INLINE int sbi_domain_is_cloud(const sb_domain *domain) { return sbi_element_is_cloud(sbi_domain_element(domain)); }
/* mass[nodes][nodes] (m^3) of the element with nodes at x[nodes] (m); lumped masses stand on the diagonal.
 * Multiply by the density. volume_load[nodes] (m^3), may be NULL: int N_a dV, exact. */
SBI_API void sbi_element_mass(sbi_element element, sb_mass_kind kind, const sb_vec3 *x, sb_real *mass,
                              sb_real *volume_load);
#endif

#endif /* SB_DOMAIN_H */
