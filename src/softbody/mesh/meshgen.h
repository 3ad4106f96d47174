/* meshgen: structured volume meshes of simple solids. Floor 1.
 * Blocks of hexahedral cells; tets are cells cut along diagonals that match between neighbours. */
#ifndef SB_MESHGEN_H
#define SB_MESHGEN_H

#include "mesh.h"

/* Common to all: type is tet4, tet10, hex8, hex20 or hex27 (edges are straight); the mesh is overwritten, not freed,
 * and its arrays come from `allocator` (NULL: malloc). SB_ERROR_ARGUMENT for a type, count or size out of range (the
 * node and element counts must fit an int), SB_ERROR_MEMORY; then the mesh is untouched. Same bits on every
 * machine. */

/* Box from the origin to `size` (m, each > 0) of nx * ny * nz cells (each >= 1); a cell is 1 hex or 6 tets
 * (Kuhn's). Corner nodes are numbered with x fastest, then y. */
SB_API sb_result sb_mesh_beam(sb_element_type type, int nx, int ny, int nz, sb_vec3 size, const sb_allocator *allocator,
                              sb_mesh *mesh, sb_error *error);

/* Solid cylinder of `radius` and `length` (m, > 0) around coordinate axis 0 (x), 1 (y) or 2 (z), from 0 to
 * length along it. across: cells over the diameter in [4, 20000], along >= 1: layers. Boundary nodes lie on
 * the cylinder, so the volume is too small by O(1/across^2). Nodes are numbered layer by layer. */
SB_API sb_result sb_mesh_cylinder(sb_element_type type, int axis, sb_real radius, sb_real length, int across, int along,
                                  const sb_allocator *allocator, sb_mesh *mesh, sb_error *error);

/* Solid ellipsoid around the origin with semi-axes (m, each > 0); cells over each diameter in [4, 500].
 * Boundary nodes lie on the ellipsoid. */
SB_API sb_result sb_mesh_ellipsoid(sb_element_type type, sb_vec3 semi_axes, int cells, const sb_allocator *allocator,
                                   sb_mesh *mesh, sb_error *error);

/* A solid like a human liver for demonstrations: 1.5 litre (1.2 at 4 cells), 20 cm wide (x, the thick right
 * lobe at negative x), dome above (z up), hollow below, a notch in the front edge (negative y). cells in [4,
 * 60] over its width; every element is sound (sb_mesh_element_quality above 0.2). */
SB_API sb_result sb_mesh_organ(sb_element_type type, int cells, const sb_allocator *allocator, sb_mesh *mesh,
                               sb_error *error);

#endif /* SB_MESHGEN_H */
