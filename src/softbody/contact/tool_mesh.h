/* tool_mesh: a closed surface as a grid of distances, which a C1 function passes through. Internal to contact, floor 4.
 *
 *     . . . . . . . .      Nodes lie in cubes round the surface's box, three cells farther than it. Within two cells of
 *     . +---------+ .      the box the function is tricubic, along each axis from the four nodes about a point (Catmull
 *     . | ,----.  | .      and Rom 1974): it has the distances at the nodes, is exact for quadratic ones, and has a
 *     . | `----'  | .      continuous gradient, unlike a trilinear one, whose jumps are felt as edges. Details smaller
 *     . +---------+ .      than a cell or two are rounded off. Farther out a lower bound of the distance goes on.
 *     . . . . . . . . */
#ifndef SB_TOOL_MESH_H
#define SB_TOOL_MESH_H

#include "../geometry/surface.h"
#include "tool.h"

typedef struct sbi_tool_grid {
    int counts[3]; /* nodes along each axis */
    sb_vec3 low;   /* m: node (0, 0, 0) */
    sb_real cell;  /* m */
    sb_vec3 surface_low, surface_high;
    sb_real inner_radius;                /* m: depth of the skeleton */
    sb_vec3 skeleton_low, skeleton_high; /* m: box of all nodes that are so deep */
    int skeleton_count;
    sb_vec3 *skeleton; /* [SBI_TOOL_MAX_SKELETON] some of them, at the hull */
    float *distances;  /* [counts[2]][counts[1]][counts[0]], in cells */
} sbi_tool_grid;

/* Checks the surface and the cells of a def, makes the surface and lays the grid out. */
SBI_API sb_result sbi_tool_grid_lay_out(const sb_tool_def *def, const sb_allocator *allocator, sb_surface **surface,
                                        sbi_tool_grid *grid, sb_error *error);
SBI_API size_t sbi_tool_grid_node_count(const sbi_tool_grid *grid);
/* Fills the arrays, which the caller has set, and finds the skeleton. SB_ERROR_UNSUPPORTED when the tool is thinner
 * than its cells. */
SBI_API sb_result sbi_tool_grid_fill(sbi_tool_grid *grid, const sb_surface *surface, const sb_allocator *allocator,
                                     const sb_jobs *jobs, sb_error *error);
SBI_API sb_real sbi_tool_grid_distance(const sbi_tool_grid *grid, sb_vec3 x, sb_vec3 fallback, sb_vec3 *normal);

#endif /* SB_TOOL_MESH_H */
