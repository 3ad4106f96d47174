/* prior: what acts on an organ before anything was seen: tractions on its surface, a Gaussian process, and gravity.
 * Floor 6, internal.
 *
 * The traction is tau(x) = sum_j psi_j(x) tau_j of control points spread over the surface, psi_j >= 0 of compact
 * support that sum to 1, and per axis cov(tau_i, tau_j) = s^2 c_i c_j d_i d_j k(|x_i - x_j| / l),   k(z) = (1 + sqrt3
 * z) exp(-sqrt3 z)     (Matern 3/2) with s one scale for all, d a local one whose square has the mean 1, and l a
 * length. What acts on thin parts is limited by what they would do under it (c, `calm`): with loads as elsewhere an ear
 * would move by more than the whole organ is long, and does so where it is not seen. Nodes bear the forces f_a = int
 * N_a tau dA, integrated over the facets (6 points on a tri6: sharing a facet's area evenly over its six nodes would
 * put half of the load on corners that bear none of it). Gravity adds f_a = a int N_a dV / V. */
#ifndef REGI_PRIOR_H
#define REGI_PRIOR_H

#include "../softbody/mesh/mesh.h"
#include "api.h"

enum { REGI_PRIOR_CONTROLS = 240 }; /* at most */

typedef struct regi_prior {
    int node_count;    /* of the organ */
    int control_count; /* c */
    int wide;          /* what sbi_lanes_are_wide() said */
    double size;       /* m: diagonal of the organ's box */
    double area;       /* m^2 of its surface */
    sb_vec3 *places;   /* [c] control points at rest (m) */
    double *areas;     /* [c] int psi_j dA (m^2) */
    double *calm;      /* [c] share of the scale that it has: less than 1 where the organ gives way; 1 once made */
    int *start;        /* [nodes + 1] into controls and shares */
    int *controls;     /* by node: the control points whose traction it bears a part of, ascending, */
    sb_real *shares;   /* and int N_a psi_j dA (m^2) */
    sb_real *weight;   /* [nodes] int N_a dV / V */
    sb_allocator allocator;
    void *memory, *lists;
} regi_prior;

/* For a mesh of volumes and its boundary, made with compact 1. SB_ERROR_MESH (no area, no volume), SB_ERROR_MEMORY. */
REGI_API sb_result regi_prior_create(const sb_mesh *mesh, const sb_boundary *boundary, const sb_allocator *allocator,
                                     regi_prior *prior, sb_error *error);
REGI_API void regi_prior_free(regi_prior *prior); /* zeros are fine */

/* Forces (N) of tractions[c] (Pa) and of a total weight (N): forces[nodes] are overwritten. */
REGI_API void regi_prior_forces(const regi_prior *prior, const sb_vec3 *tractions, sb_vec3 weight, sb_vec3 *forces);
/* What the forces of one traction do along a row: out[c][3] = sum_a shares_aj row_a, row[nodes]. */
REGI_API void regi_prior_collect(const regi_prior *prior, const sb_vec3 *row, sb_vec3 *out, sb_vec3 *weight);

/* root[c][c], lower: C D k D C + jitter = root root^T for a length in shares of the size and local[c] (d; NULL: 1).
 * Returns 0 when it has none. */
REGI_API int regi_prior_root(const regi_prior *prior, double length, const double *local, double *root);
/* local[c]: the local scale that energy[c], what is expected of |tau_j|^2, suggests after smoothing over half the
 * length. */
REGI_API void regi_prior_localise(const regi_prior *prior, double length, const double *energy, double *local);

#endif /* REGI_PRIOR_H */
