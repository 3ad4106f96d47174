/* particles: bodies without elements: point-based animation and moving least squares on a background grid. Floor 2. */
#ifndef SB_PARTICLES_H
#define SB_PARTICLES_H

#include "../fem/domain.h"
#include "grid.h"
#include "surface.h"

/* A body is a cloud of particles, which are its nodes. An integration point has no element about it but the particles
 * nearest to it; a kernel weighs them, and what is linear in space comes out exact:
 *
 *      o     o     o     o         point-based animation: every particle is an integration point with a volume of its
 *         .-----.                  own. SPH gradient: v_j grad W_j; it misses linear fields by 20 to 70 % and is here
 *      o /   o   \ o     o         for comparison. MLS gradient: least squares over the neighbours, exact for linear
 *        |   x   |                 fields. [Mueller et al. 2004; thesis of Brunet 2020, section 3.3]
 *      o \   o   / o     o         grid: points of a grid of bricks, 1 or 8 in each, those outside dropped; moving
 * least
 *         '-----'                  squares shape functions with 1, 4, 7 or 10 monomials. [Brunet 2020, section 3.4]
 *      o     o     o     o
 *
 * What comes out is a mesh of clouds (see sb_element_table) and a domain, from which a body is made; materials, steps,
 * static solves, supports, states and recordings are those of any body:
 *     sb_particles_def settings = sb_default_particles_def();
 *     settings.outer.surface = liver;
 *     sb_particles_create(&settings, &particles, &error);
 *     def.mesh = &particles.mesh;
 *     def.domain = &particles.domain;
 * Shape functions are not 1 at their own particle: supports and loads act on points of space through rows of weights
 * (sb_particles_map_points, _map_surface); a particle that is held makes the body stiffer by about one spacing.
 *
 * Cost. A row of the tangent has some 30 to 50 blocks with 10 neighbours, with 20 some 80 to 100: what makes or reads
 * it costs about what its points times the square of the neighbours cost. Linearised steps of corotated bodies do
 * without it where they are short (see sb_body_def.preconditioner): those cost what points times neighbours do. */

typedef enum sb_particle_method {
    SB_PARTICLES_SPH = 1, /* points are particles, gradients v_j grad W_j (eq. 3.17) */
    SB_PARTICLES_MLS = 2, /* points are particles, gradients by least squares (eq. 3.19) */
    SB_PARTICLES_GRID = 3 /* points of a background grid, moving least squares (eqs. 3.24, 3.25) */
} sb_particle_method;

/* Kernels W = w(q) / h^3, q = r / h, 0 from r = h on, with integral 1 in space (eqs. 3.3 to 3.7). Results hardly depend
 * on which one. */
typedef enum sb_kernel {
    SB_KERNEL_SPIKY = 1,  /* 15/pi (1 - q)^3 */
    SB_KERNEL_POLY6 = 2,  /* 315/(64 pi) (1 - q^2)^3 */
    SB_KERNEL_COSINE = 3, /* k (1 + cos(pi (1 + q) / 2)), k = 1 / (4 (pi/3 - 8/pi + 16/pi^2)) */
    SB_KERNEL_CUBIC = 4,  /* spline: 8/pi (1 - 6 q^2 + 6 q^3) up to q = 1/2, then 16/pi (1 - q)^3 */
    SB_KERNEL_QUARTIC = 5 /* 105/(16 pi) (1 - 6 q^2 + 8 q^3 - 3 q^4) */
} sb_kernel;

/* W (1/m^3) and dW/dr (1/m^4) at distance r (m, >= 0) for the radius h (m, > 0); 0 for an unknown kernel and where an
 * argument is out of range. */
SB_API sb_real sb_kernel_value(sb_kernel kernel, sb_real r, sb_real h);
SB_API sb_real sb_kernel_slope(sb_kernel kernel, sb_real r, sb_real h);

/* Radius h of a point's kernel (eqs. 3.8 to 3.10). */
typedef enum sb_radius_rule {
    SB_RADIUS_FIXED = 1,    /* radius; neighbours are all particles within it */
    SB_RADIUS_FARTHEST = 2, /* dilatation times the distance of the farthest neighbour */
    SB_RADIUS_MEAN = 3      /* dilatation times the neighbours' mean distance */
} sb_radius_rule;

enum { SB_MAX_NEIGHBOURS = SB_MAX_ELEMENT_NODES - 1 };

/* What particles are made from. Start from sb_default_particles_def(). */
typedef struct sb_particles_def {
    sb_particle_method method;  /* default SB_PARTICLES_GRID */
    sb_kernel kernel;           /* default SB_KERNEL_CUBIC */
    sb_radius_rule radius_rule; /* default SB_RADIUS_FARTHEST */
    sb_real radius;             /* (m) of SB_RADIUS_FIXED, > 0 there */
    sb_real dilatation;    /* of the other two, in [1, 10]; default 1.5. SPH wants 1: its kernel is to end where its
                            * neighbours do */
    int neighbours;        /* a point takes so many of the nearest particles, in [4, SB_MAX_NEIGHBOURS]; default
                            * 10. Of particles that are equally far, and that a mirror through the point and along
                            * the axes takes to each other, all are taken or none: the body of a symmetric cloud is
                            * symmetric, and a point in the middle of eight particles takes eight for 10. A grid
                            * needs twice as many as `basis`; where that is missed by such a group it is taken,
                            * up to SB_MAX_ELEMENT_NODES. Ten monomials want 27: three layers in every direction */
    int basis;             /* monomials of the grid's functions: 1, 4 (linear), 7, 10 (quadratic); default 4. 1
                            * misses linear fields, as SPH does */
    int points_per_cell;   /* of the grid, 1 or 8; default 8. 1 leaves motions that cost nothing: steps pass over
                            * them, static solves want sb_particles_stabilise */
    int level;             /* octree of cut cells (sb_grid_def), [0, SB_GRID_MAX_LEVEL]; default 2 */
    int consistent;        /* 1 (default): gradients are corrected so that constant stress is in balance about all
                            * particles away from the surface (variationally consistent integration: Chen, Hillman,
                            * Rueter 2013, in a symmetric form). Only with an `outer` shape, MLS or a basis >= 4 */
    sb_shape outer;        /* the body. Needed but for clouds of points without a grid */
    const sb_shape *inner; /* [inner_count] other regions and holes, or NULL; as in sb_grid_def */
    int inner_count;
    sb_vec3 low, high;     /* box to cover (m); equal (default): that of outer.surface */
    int cells;             /* cells along the longest side of the box; default 10 */
    sb_real spacing;       /* edge of a cell (m) instead; 0 (default): from `cells` */
    int counts[3];         /* cells along each axis instead; 0 (default) */
    const sb_vec3 *points; /* [point_count] particles of your own (m), or NULL: the nodes of the grid's cells, of
                            * SPH and MLS the middles of those that are at least half inside */
    int point_count;
    const sb_real *volumes; /* [point_count] (m^3), > 0, that SPH and MLS points stand for; NULL: of the grid, or for
                             * points of your own from their distances (eqs. 3.12, 3.13) */
    sb_real volume;         /* (m^3) that volumes are scaled to sum up to; 0 (default): the inside of `outer`, without
                             * one as they are, which is 10 to 20 % off on a lattice */
    sb_allocator allocator; /* default malloc */
    sb_jobs jobs;           /* default inline */
    unsigned cookie;        /* set by sb_default_particles_def; a def made without it is refused */
} sb_particles_def;

SB_API sb_particles_def sb_default_particles_def(void);

/* Particles. Zero-initialise; release with sb_particles_free, after the bodies made of them. */
typedef struct sb_particles {
    sb_mesh mesh;            /* nodes: the particles; an element for each integration point: its neighbours, nearest
                              * first, after its own particle if it is one. The last may be there several times */
    sb_domain domain;        /* one point per element, with weights, gradients and masses */
    sb_element_table *table; /* of the mesh's elements */
    sb_vec3 *points;         /* [mesh.element_count] (m) integration points */
    sb_real *radii;          /* [mesh.element_count] (m) of their kernels */
    sb_real *shapes;         /* [mesh.element_count][domain.nodes_per_cell] shape functions there */
    unsigned char *inner;    /* [mesh.node_count] 1: gradients were made consistent about the particle */
    sb_real volume;          /* (m^3) sum of weights */
    sb_real spacing;         /* (m) edge of the cube that each particle has on average */
    int grown;               /* points whose radius had to grow, up to three times by 1.2 */
    int lost;                /* points that cuts left with neighbours that do not span space: what those do not see
                              * costs nothing there */
    sb_real worst_condition; /* largest of the points' moment matrices (an estimate); more than 1e8 is refused */
    sb_real imbalance;       /* largest |sum_p w_p g_pa| / sum_p w_p |g_pa| over inner particles, before the correction;
                              * 0 without an `outer` shape */
    sb_particles_def def;    /* what they were made from; its pointers are NULL */
    sb_surface **cuts;       /* [cut_count] made so far */
    int cut_count;
} sb_particles;

/* Makes particles. Same bits for any threads. SB_ERROR_ARGUMENT (a field out of range, named), SB_ERROR_NOT_FINITE (a
 * point, a number, or what volumes sum up to), SB_ERROR_MESH (error->node names a particle at the place of another,
 * error->element a point whose neighbours stay in a plane after growing; nothing is inside), SB_ERROR_UNSUPPORTED (a
 * point with more particles than SB_MAX_ELEMENT_NODES), and what sb_grid_create returns; *particles is untouched. */
SB_API sb_result sb_particles_create(const sb_particles_def *def, sb_particles *particles, sb_error *error);
SB_API void sb_particles_free(sb_particles *particles); /* NULL and {0} are fine */

/* Rows of points[count] (m), in their order, for sb_body_add_mapping, sb_body_add_constraints and sb_mapping_apply: a
 * point is a sum of the positions of its neighbours by moving least squares functions, of four monomials for SPH and
 * MLS. In rows, `cells` is the nearest particle and `farthest` the largest distance to it. Points outside are
 * extrapolated, SB_ERROR_ARGUMENT names (error->node) the first farther than two spacings from any particle,
 * SB_ERROR_NOT_FINITE one that is not finite, SB_ERROR_MESH one whose neighbours do not span space;
 * SB_ERROR_MEMORY. *rows is untouched then. Release with sb_grid_rows_free. Source: eqs. 3.36, 3.37, where point-based
 * bodies need moving least squares functions of their own. */
SB_API sb_result sb_particles_map_points(const sb_particles *particles, const sb_vec3 *points, int count,
                                         const sb_allocator *allocator, sb_grid_rows *rows, sb_error *error);
/* Rows of points of triangles[count] (indices of elements; NULL: of all, count is not read) of a tri3 mesh, one for
 * each piece when triangles are cut into pieces no longer than a spacing; areas sum to those of the triangles and first
 * moments are exact. sb_grid_add_traction makes forces of tractions. Errors as above, and SB_ERROR_INDEX (a triangle),
 * SB_ERROR_UNSUPPORTED (more rows than an int counts). */
SB_API sb_result sb_particles_map_surface(const sb_particles *particles, const sb_mesh *surface, const int *triangles,
                                          int count, const sb_allocator *allocator, sb_grid_rows *rows,
                                          sb_error *error);

/* Cuts along a surface of triangles or quads, open or closed: no point has neighbours that a segment through it leads
 * to, then or in cuts to come. Points are made anew where that changes something, with growing radii; one whose
 * neighbours do not span space even then does without what they do not see (`lost`). Make a new body of the result; the
 * old one keeps what it copied, but borrows a table that stays until sb_particles_free: destroy it before that. Errors
 * as sb_surface_create, SB_ERROR_ARGUMENT, SB_ERROR_UNSUPPORTED (as sb_particles_create), SB_ERROR_MEMORY; *particles
 * is as it was. */
SB_API sb_result sb_particles_cut(sb_particles *particles, const sb_mesh *surface, sb_error *error);

#endif /* SB_PARTICLES_H */
