/* mixture: elements that lie in several organs, each with its share of their volume. Floor 2. */
#ifndef SB_MIXTURE_H
#define SB_MIXTURE_H

#include "../fem/domain.h"
#include "surface.h"

/* Where no mesh follows the surface between two organs (one is too small, or the mesh was there first), elements lie in
 * both. With one region for each, the one with most of it, stiffness jumps by whole elements:
 *
 *     +-----+-----+-----+        one region each: the organ is a heap of elements
 *     |    /|\    |     |        mixture: an element is there once for each region that it has part of, with the same
 *     |   / | \   |     |        nodes and with weights and masses times its share. Energies of materials are then
 *     +--/--+--\--+-----+        mixed by volume at one deformation (Voigt), whatever the materials are: nonlinear,
 *     | organ   \ |     |        with fibres, relaxing; so are densities, damping and what else belongs to a region.
 *     +-----+----\+-----+        [thesis of Chentanez 2010, section 2.5, which names no mean]
 *
 * What comes out is a mesh and a domain for a body, whose materials are set by region as ever:
 *     sb_mixture_def settings = sb_default_mixture_def();
 *     settings.mesh = &tets;
 *     settings.shapes = &tumour;
 *     settings.shape_count = 1;
 *     sb_mixture_create(&settings, &mixture, &error);
 *     def.mesh = &mixture.body_mesh;
 *     def.domain = &mixture.domain;
 * Nodes are those of the mesh, so supports, loads, embedded points and pictures go on with that. Bodies with a domain
 * of their own cannot be cut, nor can their mesh change (sb_body_def.slack).
 * Needles with NDL_EMBED and registration see each element once. To a needle it has Lame's moduli by the weights of its
 * parts, and friction, cutting and twist by their shares; membranes lie between elements, by the largest part of each.
 * What nodules as large as elements, 10 and 0.2 times as stiff, add to the stiffness across a needle near them is off
 * (N/m, root mean square of 12 each, against a mesh 2.8 times as fine) by 24 and 8 with the geometric mean, 52 and 19
 * with Reuss's, 72 and 9 with Voigt's, 57 and 18 with one region for each element: take the geometric.
 *
 * Which mean. Mixed by volume alone (Voigt) an element is too stiff where the interface lies across the load; with
 * moduli given, geometric or Reuss's means are wanted. What balls, 10 times and 0.2 times as stiff as the block about
 * them, add to its stiffness in pulling, tet4 with edges from 1 to 1.5 of the radius: off by 37 % (root mean square)
 * with one region for each element, by 103 and 31 % with Voigt's mean, by 35 and 10 % with the geometric, by 17 and 13
 * % with Reuss's; with half the edges 27 and 17, 50 and 19, 22 and 7, 2 and 6 %.
 *
 * Shares. An element that a surface may cross is divided into level^3 smaller tets (six times as many of hexes); in
 * each, distances are taken to be linear between its corners, and what lies on either side is cut off exactly. So
 * planes have exact shares; a surface with radius of curvature R is moved by no more than l^2 / (8 R), l the smaller
 * tets' longest edge, and what is thinner than l may be missed. Shares of an element sum to 1: the mesh's volume is
 * kept to rounding. */

/* What an element is as stiff as whose parts, of shares s, have the stiffnesses E: (sum s E^p)^(1/p). */
typedef enum sb_mixture_mean {
    SB_MIXTURE_VOIGT = 1,     /* p = 1, layers along the load: an upper bound, never too soft. Default */
    SB_MIXTURE_GEOMETRIC = 2, /* p to 0: between the two */
    SB_MIXTURE_REUSS = 3      /* p = -1, layers across the load: a lower bound */
} sb_mixture_mean;

enum {
    SB_MIXTURE_MAX_SHAPES = 30,
    SB_MIXTURE_MAX_LEVEL = 16 /* of sb_mixture_def.level */
};

/* What is mixed. Start from sb_default_mixture_def(), set mesh and shapes. */
typedef struct sb_mixture_def {
    const sb_mesh *mesh;    /* volume mesh (m) without SB_CUSTOM; what lies in no shape keeps its regions (0 where there
                             * are none). Read during the call only, as are the shapes */
    const sb_shape *shapes; /* [shape_count] organs. Where they overlap the last one counts. Surfaces: closed; holes are
                             * bridged by their winding number */
    int shape_count;        /* in [1, SB_MIXTURE_MAX_SHAPES] */
    int level;              /* parts that an edge of a cut element is divided into, [1, SB_MIXTURE_MAX_LEVEL];
                             * default 4. Cost of an element: (level + 1)^3 / 6 distances of tets, (level + 1)^3 of hexes */
    sb_real least_share;  /* less than this of an element goes to the region with most of it, [0, 0.5); default 1e-3 */
    sb_mixture_mean mean; /* default SB_MIXTURE_VOIGT */
    const sb_real *stiffness;   /* [1 + shape_count] > 0: Young's moduli (Pa), or what else is in proportion, of the
                                 * mesh's own regions and of the shapes; read where `mean` is not Voigt; default NULL. All
                                 * weights of an element are then less by the ratio of both means; masses are not */
    sb_integration integration; /* points of the elements, as in sb_body_def; default SB_INTEGRATION_AUTO */
    int single_rotation;        /* likewise; default 0 */
    sb_allocator allocator;     /* default malloc */
    unsigned cookie;            /* set by sb_default_mixture_def; a def made without it is refused */
} sb_mixture_def;

SB_API sb_mixture_def sb_default_mixture_def(void);

/* A mixture. Zero-initialise; release with sb_mixture_free. */
typedef struct sb_mixture {
    sb_mesh body_mesh; /* what a body's elements are: the mesh's nodes, and each of its elements once for each region
                        * that it has part of, side by side, the largest part first */
    sb_domain domain;  /* points, weights and masses of body_mesh */
    int *elements;     /* [body_mesh.element_count] element of def.mesh, ascending */
    sb_real *shares;   /* [body_mesh.element_count] of that element's volume, (0, 1] */
    int mixed_count;   /* elements of def.mesh with more than one region */
    int region_count;
    int *regions;            /* [region_count] those that have any volume, ascending */
    sb_real *region_volumes; /* [region_count] (m^3) */
    sb_real volume;          /* (m^3) their sum: that of the mesh */
    sb_allocator allocator;
} sb_mixture;

/* Makes a mixture. SB_ERROR_ARGUMENT (a field out of range, named; a surface mesh), SB_ERROR_NOT_FINITE (a distance;
 * error->element), SB_ERROR_MESH (a surface or a part of it is inside out, or what sb_mesh_validate and
 * sb_domain_create refuse), SB_ERROR_INDEX, SB_ERROR_UNSUPPORTED (SB_CUSTOM, an element left out by SB_ELEMENT, more
 * elements than an int counts), SB_ERROR_MEMORY; *mixture is untouched. Calls `distance` from one thread. */
SB_API sb_result sb_mixture_create(const sb_mixture_def *def, sb_mixture *mixture, sb_error *error);
SB_API void sb_mixture_free(sb_mixture *mixture); /* NULL and {0} are fine */

#endif /* SB_MIXTURE_H */
