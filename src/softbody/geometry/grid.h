/* grid: regular hexahedral grids round bodies whose surface cuts the cells (immersed boundary). Floor 2. */
#ifndef SB_GRID_H
#define SB_GRID_H

#include "../fem/domain.h"
#include "surface.h"

/* A surface that no mesh follows is laid into a grid of bricks. Bricks that it does not touch are dropped, those it
 * cuts are integrated over the part that is inside:
 *
 *     +------+------+------+      sparse: as if they were full. Cheapest, too stiff, jumps with the grid's position
 *     |   ,--+------+--.   |      finite cell: cut again and again into eight where the surface goes (an octree); the
 *     |  /   |      |   \  |          points of its leaves that are inside. Exact as the level grows, as does the cost
 *     +-|----+------+----|-+      weighted cell: the eight points that a full brick has, each with the inside share of
 *     |  \   |      |   /  |          its octant as weight, from the same octree. Costs as much as a plain mesh at any
 *     level |   `--+------+--'   |
 *     +------+------+------+      [thesis of Brunet 2020, chapter 4; finite cell: Parvizian, Duester, Rank 2007]
 *
 * What comes out is a mesh and a domain for a body:
 *     sb_grid_def settings = sb_default_grid_def();
 *     settings.outer.surface = liver;
 *     sb_grid_create(&settings, &grid, &error);
 *     def.mesh = &grid.body_mesh;
 *     def.domain = &grid.domain;
 * Supports and loads act on points of the surface, through rows of node weights (sb_grid_map_points, _map_surface). */

typedef enum sb_grid_method { SB_GRID_SPARSE = 1, SB_GRID_FINITE_CELL = 2, SB_GRID_WEIGHTED_CELL = 3 } sb_grid_method;

enum {
    SB_GRID_EMPTY = -1,      /* region of a shape that is a hole */
    SB_GRID_MAX_SHAPES = 30, /* the outer one and the inner ones */
    SB_GRID_MAX_LEVEL = 8
};

/* What a grid is made from. Start from sb_default_grid_def(). */
typedef struct sb_grid_def {
    sb_grid_method method;  /* default SB_GRID_WEIGHTED_CELL */
    int level;              /* how often cut cells are halved, [0, SB_GRID_MAX_LEVEL]; default 3. 0 is the sparse grid.
                             * More than 3 hardly changes weighted cells; finite cells have four times the points
                             * with each level */
    sb_shape outer;         /* the body */
    const sb_shape *inner;  /* [inner_count] parts of other regions (tumours, vessels), or NULL; holes have the region
                             * SB_GRID_EMPTY. Where they overlap, the
                             * last one counts; what sticks out of the outer shape does not */
    int inner_count;        /* at most SB_GRID_MAX_SHAPES - 1 */
    sb_vec3 low, high;      /* box that the grid is to cover (m); equal (default): that of outer.surface */
    int cells;              /* cells along the longest side of the box, in [1, 2000]; default 10. They are cubes, and
                             * the grid is centred round the box */
    sb_real cell_size;      /* edge of a cell (m) instead; 0 (default): from `cells` */
    int counts[3];          /* cells along each axis instead, so that the grid is the box and its cells need not be
                             * cubes; 0 (default): from the above */
    sb_real void_stiffness; /* share of the stiffness that points outside keep, [0, 1); default 1e-4. It holds what
                             * hangs on nearly nothing. 0 may leave the tangent singular. Has no mass */
    sb_real least_share;    /* cells with less of their volume inside are dropped, [0, 1); default 0: only those in
                             * which no point was found inside */
    int max_points;         /* finite cells: more points (with those of uncut cells) are refused rather than computed
                             * with, >= 8; default 4,000,000. Each costs about 400 bytes in a body */
    sb_allocator allocator; /* default malloc */
    sb_jobs jobs;           /* default inline */
    int (*progress)(void *user, double share); /* called now and then by the caller's thread with the share of work
                                                * done, in (0, 1]; a result other than 0 cancels. Default NULL */
    void *progress_user;
    unsigned cookie; /* set by sb_default_grid_def; a def made without it is refused */
} sb_grid_def;

SB_API sb_grid_def sb_default_grid_def(void);

/* A grid. Zero-initialise; release with sb_grid_free. */
typedef struct sb_grid {
    sb_mesh mesh;      /* hex8: the cells that are kept, once each; for pictures and embedding. regions: the one
                        * with most of the cell */
    sb_mesh body_mesh; /* hex8: what a body's elements are. The same nodes; each cell once for every eight points
                        * and for each of its regions */
    sb_domain domain;  /* points, weights and masses of body_mesh */
    int *body_cells;   /* [body_mesh.element_count] element of mesh that each belongs to, ascending */
    sb_real *shares;   /* [mesh.element_count] share of the cell's volume that is inside, (0, 1]; sparse: 1 */
    sb_vec3 origin;    /* (m) low corner */
    sb_vec3 cell_size; /* (m) */
    int counts[3];     /* cells along each axis, dropped ones included */
    int *lattice;      /* [counts[2]][counts[1]][counts[0]] element of mesh, or -1 */
    int cut_count;     /* elements of mesh that a surface cuts */
    int region_count;
    int *regions;            /* [region_count] the outer shape's, then others in the order of the inner shapes */
    sb_real *region_volumes; /* [region_count] (m^3) */
    sb_real volume;          /* (m^3) their sum */
    sb_allocator allocator;
} sb_grid;

/* Makes a grid. Same bits for any threads. SB_ERROR_ARGUMENT (a field out of range, named), SB_ERROR_NOT_FINITE (box,
 * cell_size, or a distance), SB_ERROR_MESH (no cell has anything inside, or a surface or a part of it is inside out),
 * SB_ERROR_UNSUPPORTED (more cells than an int counts, more points than max_points), SB_ERROR_CANCELLED,
 * SB_ERROR_MEMORY; *grid is untouched. Cost: for each cut cell some 4^level distances. */
SB_API sb_result sb_grid_create(const sb_grid_def *def, sb_grid *grid, sb_error *error);
SB_API void sb_grid_free(sb_grid *grid); /* NULL and {0} are fine */

/* ---- points of the body in the grid ----
 * The surface mapping H: a point is a sum of the positions of the eight nodes of its cell. */

/* Rows for points of space or of a surface. Release with sb_grid_rows_free. */
typedef struct sb_grid_rows {
    sb_mapping rows;        /* eight nodes and weights each, for sb_body_add_mapping and sb_mapping_apply */
    const int *cells;       /* [row_count] element of grid.mesh */
    const sb_vec3 *points;  /* [row_count] (m) */
    const sb_real *areas;   /* [row_count] (m^2) that the point stands for: of sb_grid_map_surface, else NULL */
    const sb_vec3 *normals; /* [row_count] unit normals of its triangle; likewise */
    sb_real farthest;       /* (m) largest distance of a point from the cell it was put to: 0 when all are inside */
    void *memory;           /* behind the arrays */
    sb_allocator allocator;
} sb_grid_rows;

/* Rows of points[count] (m), in their order. A point outside all kept cells belongs to the nearest one, whose shape
 * functions go on outside: rows give back positions, and carry the force and moment of a load, exactly all the same.
 * SB_ERROR_ARGUMENT names (error->node) the first that is farther away than the longest edge of a cell,
 * SB_ERROR_NOT_FINITE one that is not finite; SB_ERROR_MEMORY. *rows is untouched then. O(count). Source: eqs. 4.4,
 * 4.16. */
SB_API sb_result sb_grid_map_points(const sb_grid *grid, const sb_vec3 *points, int count,
                                    const sb_allocator *allocator, sb_grid_rows *rows, sb_error *error);
/* Rows of integration points of triangles[count] (indices of elements; NULL: of all, count is not read) of a tri3 mesh,
 * cut finely enough for the cells: one for a triangle with edges up to half a cell, otherwise three in each of its
 * pieces with edges up to a cell. Their areas sum to that of the triangles, and their moments are exact. Errors as
 * above, and SB_ERROR_INDEX (a triangle), SB_ERROR_MESH (one without area), SB_ERROR_UNSUPPORTED (more rows than an int
 * counts).
 *     Penalty displacements (eqs. 4.18-4.21): sb_body_add_mapping(body, &rows.rows, stiffness, 0, targets, ...) with
 *     stiffness[j] = kappa areas[j], kappa (Pa/m) some 10 to 100 times Young's modulus over the cell size. */
SB_API sb_result sb_grid_map_surface(const sb_grid *grid, const sb_mesh *surface, const int *triangles, int count,
                                     const sb_allocator *allocator, sb_grid_rows *rows, sb_error *error);
SB_API void sb_grid_rows_free(sb_grid_rows *rows); /* NULL and {0} are fine */

/* forces[nodes of the grid] (N) += what tractions[row_count] (Pa on the undeformed area), or one for all when uniform
 * is 1, exert on the nodes; hand them to sb_body_add_forces. Rows need areas; others change nothing. Source: eqs.
 * 4.14-4.17. */
SB_API void sb_grid_add_traction(const sb_grid_rows *rows, const sb_vec3 *tractions, int uniform, sb_vec3 *forces);

#endif /* SB_GRID_H */
