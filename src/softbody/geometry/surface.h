/* surface: closest point, ray, signed distance, winding number and inside test on a triangle surface; its checks and
 * repairs. Floor 2.
 *
 *     sb_surface *skin = NULL;
 *     if (sb_surface_create(&mesh, NULL, &skin, &error) != SB_OK) ...
 *     sb_real d = sb_surface_signed_distance(skin, point, &hit);   (m, negative inside)
 *     sb_surface_destroy(skin);
 *
 * Surfaces are oriented outward: corners counter-clockwise seen from outside. Queries allocate nothing, change nothing
 * (so any number of threads may ask at once) and give the same bits for any tree, thread count and compiler: the
 * closest triangle is the one whose own distance is smallest, of equal ones that with the lowest number. */
#ifndef SB_SURFACE_H
#define SB_SURFACE_H

#include "../mesh/mesh.h"

/* A surface of triangles with its tree of boxes, made by sb_surface_create; independent of the mesh it was made of. */
typedef struct sb_surface sb_surface;

/* Where on its triangle a point lies. */
typedef enum sb_surface_feature {
    SB_SURFACE_FACE = 0,
    SB_SURFACE_EDGE = 1,  /* edge i joins corners i and i + 1 (2: corners 2 and 0) */
    SB_SURFACE_VERTEX = 2 /* corner i */
} sb_surface_feature;

/* What a query found. For a query that finds nothing, triangle and element are -1, distance is infinite, the rest 0. */
typedef struct sb_surface_hit {
    int triangle;               /* in [0, sb_surface_triangle_count) */
    int element;                /* of the mesh: the triangle's, or the face that was cut into triangles */
    sb_surface_feature feature; /* which kind of place on the triangle, and with `index` which of them */
    int index;                  /* edge or corner, 0 for a face */
    sb_vec3 point;              /* m, on the surface */
    sb_real weights[3];         /* of the triangle's corners, >= 0 up to rounding; point = sum weight_i corner_i */
    sb_real distance;           /* m; rays: from the origin along the ray. Signed distance queries: with its sign */
} sb_surface_hit;

/* ---- life ---------------------------------------------------------------------------------------------------- */

/* Makes a surface of a mesh of tri3, tri6, quad4, quad8 or quad9; faces other than tri3 are cut into flat triangles
 * between their nodes. Nodes are copied. Surfaces that are open, touch themselves or have degenerate triangles are
 * welcome (scans are like that): sb_surface_check reports it, and each query below says what it then means. One block
 * of memory from `allocator` (NULL: malloc) for everything (about 280 bytes per triangle), plus scratch that goes back.
 * O(triangles log triangles), about 0.1 s for 100,000. SB_ERROR_ARGUMENT (null pointer, a mesh of volumes: take
 * sb_mesh_boundary), _MESH (empty, or too many triangles), _NOT_FINITE, _INDEX, _MEMORY; then *surface is untouched. */
SB_API sb_result sb_surface_create(const sb_mesh *mesh, const sb_allocator *allocator, sb_surface **surface,
                                   sb_error *error);
SB_API void sb_surface_destroy(sb_surface *surface); /* accepts NULL */

/* Moves the nodes to nodes[sb_surface_node_count] (m) and refits boxes, normals and far fields in one pass over the
 * triangles, in parallel on `jobs` (NULL: inline). The tree keeps its shape: answers stay right however far the surface
 * deforms, and stay fast as long as neighbours stay near each other. Closest points, rays and signs are those of a new
 * surface, to the bit. Allocates nothing. SB_ERROR_ARGUMENT or _NOT_FINITE (error->node): nothing has changed. */
SB_API sb_result sb_surface_move(sb_surface *surface, const sb_vec3 *nodes, const sb_jobs *jobs, sb_error *error);

/* ---- what it is made of (0 or {0} for NULL) ------------------------------------------------------------------ */

SB_API int sb_surface_node_count(const sb_surface *surface); /* nodes of the mesh, also those of no triangle */
SB_API int sb_surface_triangle_count(const sb_surface *surface);
/* Nodes of a triangle, in the order of the mesh's numbering; the mesh's element it was cut from is returned. -1
 * (nothing written) when there is no such triangle. nodes may be NULL. */
SB_API int sb_surface_triangle(const sb_surface *surface, int triangle, int nodes[3]);
/* Smallest box around the triangles (m). */
SB_API void sb_surface_bounds(const sb_surface *surface, sb_vec3 *low, sb_vec3 *high);
/* 1 when every edge is run through as often one way as the other: the surface then bounds a solid, its winding number
 * is whole, and distances have an unquestionable sign. */
SB_API int sb_surface_is_closed(const sb_surface *surface);
/* Bytes of its block of memory. */
SB_API size_t sb_surface_bytes(const sb_surface *surface);

/* ---- one query ---------------------------------------------------------------------------------------------------
 * A point with a NaN or an infinite coordinate, or 1e15 (float: 1e6) times as far off as the surface is large, finds
 * nothing: result 0, signed distance infinite for a far point and NaN for one that is no number, winding number 0. */

/* Closest point of the surface within max_distance (m, >= 0; SB_REAL_MAX: any). 1 and *hit, or 0 when nothing is as
 * near or an argument is NULL or NaN. hit may be NULL: only whether. O(log triangles). */
SB_API int sb_surface_closest(const sb_surface *surface, sb_vec3 point, sb_real max_distance, sb_surface_hit *hit);
/* The same with a triangle that is likely to be near (that of the last query, or of a neighbour; any other number: no
 * idea): the same answer, sooner. */
SB_API int sb_surface_closest_from(const sb_surface *surface, sb_vec3 point, sb_real max_distance, int triangle,
                                   sb_surface_hit *hit);

/* First triangle that the ray from origin along direction (any length but 0) meets within max (m, >= 0; SB_REAL_MAX:
 * any), from either side. 1 and *hit (or NULL), or 0. No ray slips through between triangles that share an edge or
 * corner; triangles seen exactly edge-on are not met. Source: Woop, Benthin, Wald 2013. */
SB_API int sb_surface_ray(const sb_surface *surface, sb_vec3 origin, sb_vec3 direction, sb_real max,
                          sb_surface_hit *hit);
/* All triangles that the ray meets within max: returns how many, and the first `capacity` of them in hits (may be NULL
 * with capacity 0: only count), nearest first. A ray through an edge meets both its triangles. */
SB_API int sb_surface_ray_all(const sb_surface *surface, sb_vec3 origin, sb_vec3 direction, sb_real max,
                              sb_surface_hit *hits, int capacity);

/* Distance to the surface (m), negative inside. *hit (or NULL): the closest point. The sign is that of the
 * angle-weighted pseudonormal at the closest point (Baerentzen, Aanaes 2005), exact for closed surfaces that do not
 * cross themselves; where that normal means nothing (at degenerate triangles, edges of more or fewer than two
 * triangles, corners where parts touch, folds), sb_surface_inside decides. On an open surface the sign says which side
 * of the nearest triangle the point is on. */
SB_API sb_real sb_surface_signed_distance(const sb_surface *surface, sb_vec3 point, sb_surface_hit *hit);
/* The same with the sign from sb_surface_inside everywhere: for surfaces with holes, overlaps or loose parts. About
 * twice the time far from the surface, nine times close to it, where the winding number sums many triangles exactly. */
SB_API sb_real sb_surface_signed_distance_winding(const sb_surface *surface, sb_vec3 point, sb_surface_hit *hit);

/* Generalised winding number: the solid angle under which the point sees the surface, over 4 pi. 1 inside a closed
 * surface, 0 outside, in between near holes; 2 where two solids overlap. Near triangles are summed exactly, groups of
 * far ones by their Taylor expansion to second order (Barill et al. 2018, beta 2): within 0.05 of the exact sum.
 * O(log triangles). */
SB_API sb_real sb_surface_winding_number(const sb_surface *surface, sb_vec3 point);
/* Every triangle summed exactly. O(triangles). */
SB_API sb_real sb_surface_winding_number_exact(const sb_surface *surface, sb_vec3 point);
/* 1 where the winding number is 1/2 or more. */
SB_API int sb_surface_inside(const sb_surface *surface, sb_vec3 point);

/* Unit pseudonormal at a hit, pointing outward: of the face, the mean of the two at an edge, angle-weighted at a
 * corner; 0 where there is none (degenerate triangles) or for no hit. */
SB_API sb_vec3 sb_surface_normal(const sb_surface *surface, const sb_surface_hit *hit);

/* ---- many queries, in parallel on `jobs` (NULL: inline) ---------------------------------------------------------
 * Each gives for points[count] what the single query gives, to the bit. Faster still when neighbours in the array are
 * neighbours in space. Nothing happens for NULL or a count below 1. */
SB_API void sb_surface_closest_batch(const sb_surface *surface, const sb_vec3 *points, int count, sb_real max_distance,
                                     sb_surface_hit *hits, const sb_jobs *jobs);
/* distances[count]; hits[count] or NULL. */
SB_API void sb_surface_signed_distance_batch(const sb_surface *surface, const sb_vec3 *points, int count,
                                             sb_real *distances, sb_surface_hit *hits, const sb_jobs *jobs);
SB_API void sb_surface_signed_distance_winding_batch(const sb_surface *surface, const sb_vec3 *points, int count,
                                                     sb_real *distances, sb_surface_hit *hits, const sb_jobs *jobs);
SB_API void sb_surface_winding_number_batch(const sb_surface *surface, const sb_vec3 *points, int count,
                                            sb_real *numbers, const sb_jobs *jobs);
SB_API void sb_surface_inside_batch(const sb_surface *surface, const sb_vec3 *points, int count, unsigned char *inside,
                                    const sb_jobs *jobs);

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* ---- internal: surface.c lends the cutting of faces to the checks -------------------------------------------- */

/* Triangles and the elements they were cut from. Of `triangles` only the elements are to be released, through
 * sbi_surface_cut_free; it borrows the nodes. */
typedef struct sbi_surface_cut {
    sb_mesh triangles;
    int *corners; /* [count][3] */
    int *element; /* [count] */
} sbi_surface_cut;
SBI_API sb_result sbi_surface_cut_make(const sb_mesh *mesh, const sb_allocator *allocator, sbi_surface_cut *cut,
                                       sb_error *error);
SBI_API void sbi_surface_cut_free(const sb_allocator *allocator, sbi_surface_cut *cut);
#endif

/* ---- checks ---------------------------------------------------------------------------------------------------------
 * A surface bounds a solid when every point is clearly inside or outside. What can stand against it: */
typedef enum sb_surface_finding {
    SB_SURFACE_OPEN_EDGES = 1,        /* edges of one face only: holes, or borders that were never welded */
    SB_SURFACE_FLIPPED = 2,           /* edges whose two faces are oriented against each other */
    SB_SURFACE_NONMANIFOLD_EDGES = 4, /* edges of more than two faces */
    SB_SURFACE_NONMANIFOLD_NODES = 8, /* nodes where parts touch in a point */
    SB_SURFACE_DEGENERATE = 16,       /* faces without area, or with a node twice */
    SB_SURFACE_DUPLICATES = 32,       /* faces with the corners of one before them */
    SB_SURFACE_UNWELDED = 64,         /* nodes within 1e-6 of the surface's size of another */
    SB_SURFACE_INSIDE_OUT = 128,      /* closed parts that look inward, and are not the walls of a cavity */
    SB_SURFACE_SELF_CROSSING = 256,   /* pairs of triangles that pass through each other or overlap in a plane */
    SB_SURFACE_UNREFERENCED = 512,    /* nodes of no face */
    SB_SURFACE_SEVERAL_PARTS = 1024,  /* parts that share no node: nothing wrong in itself */
    SB_SURFACE_CROWDED = 2048         /* triangles that hundreds of others lie on, closer than 1e-6 of the surface's
                                       * size, and that do not cross those looked at: the rest were not looked at */
} sb_surface_finding;

enum {
    SB_SURFACE_FINDING_COUNT = 12,
    /* What leaves it open which points are inside. */
    SB_SURFACE_NOT_SOLID = SB_SURFACE_OPEN_EDGES | SB_SURFACE_FLIPPED | SB_SURFACE_NONMANIFOLD_EDGES |
                           SB_SURFACE_INSIDE_OUT | SB_SURFACE_SELF_CROSSING | SB_SURFACE_CROWDED
};

/* How often something was found, and the first place; -1 where that has no element or node. */
typedef struct sb_surface_place {
    int count;
    int element, other_element; /* of the mesh; the other one of an edge or a crossing */
    int node, other_node;       /* ends of an edge; a node and the one it coincides with */
} sb_surface_place;

typedef struct sb_surface_report {
    int findings;                                     /* sum of the sb_surface_finding whose count is not 0 */
    sb_surface_place place[SB_SURFACE_FINDING_COUNT]; /* finding 1 << i at i; number 10: parts beyond the first */
    int crossings_partial;                            /* 1: more pairs may cross than were counted. Counting ends at 16
                                                       * for each triangle and 1024 more; see also SB_SURFACE_CROWDED */
    int parts;                                        /* parts that share no node */
    sb_real volume;                                   /* m^3 enclosed; meaningful when closed */
    sb_real area;                                     /* m^2 */
} sb_surface_report;

/* Looks a mesh of tri3, tri6, quad4, quad8 or quad9 over. SB_OK also for a bad surface; fails as sb_surface_create
 * does, and then leaves *report alone. Faces count as the mesh has them; crossings are looked for between the triangles
 * they are cut into. Triangles that only touch do not cross. O(faces log faces), also where all faces coincide, share a
 * node or are stacked; about 0.4 s for 100,000 triangles. */
SB_API sb_result sb_surface_check(const sb_mesh *mesh, const sb_allocator *allocator, sb_surface_report *report,
                                  sb_error *error);
/* One sentence that names the finding, e.g. "edges of one face only"; "unknown finding" for no single one. Static. */
SB_API const char *sb_surface_check_string(int finding);
/* sb_surface_check that fails with SB_ERROR_MESH when it finds one of `findings` (a sum of them, as
 * SB_SURFACE_NOT_SOLID): the message names the first, how many and where, error->element the first element, or
 * error->node the node. report (or NULL) is written then too. */
SB_API sb_result sb_surface_require(const sb_mesh *mesh, int findings, const sb_allocator *allocator,
                                    sb_surface_report *report, sb_error *error);

/* ---- repairs, on request only -------------------------------------------------------------------------------- */

/* The mesh of flat triangles between the nodes of a surface's faces; regions and nodes are kept. Fails as
 * sb_surface_create; the output is overwritten, not freed. */
SB_API sb_result sb_surface_triangulate(const sb_mesh *mesh, const sb_allocator *allocator, sb_mesh *triangles,
                                        sb_error *error);

typedef struct sb_surface_repair_def {
    int weld;               /* merge nodes that coincide; default 1 */
    sb_real weld_tolerance; /* m; negative (default): 1e-6 of the surface's size */
    int clean;              /* remove faces without area, duplicates and unused nodes; default 1 */
    int orient;             /* turn faces so that neighbours agree and closed parts look outward; default 1. A surface
                             * that is sound in this respect stays as it is, with its cavities */
    int max_hole_edges;     /* close holes of up to so many edges with triangles of least area, no new nodes, in
                             * [0, 256]; default 0: invent nothing. The border of an open sheet is a hole as well */
} sb_surface_repair_def;

/* What a repair did. */
typedef struct sb_surface_repair_report {
    int merged_nodes, removed_nodes;
    int removed_degenerate; /* faces without area taken out */
    int removed_duplicates;
    int flipped_edges; /* of pairs of triangles: how faces without area but with three nodes are got rid of */
    int turned_faces;
    int filled_holes, added_faces;
    int left_holes; /* holes too long, or with a border that touches itself; -1 when none were looked for */
} sb_surface_repair_report;

SB_API sb_surface_repair_def sb_default_surface_repair(void);
/* Repairs a mesh of tri3 (others: sb_surface_triangulate first; SB_ERROR_UNSUPPORTED). def and report may be NULL
 * (defaults; not wanted). What cannot be mended stays: check afterwards. New arrays come from mesh->allocator, the old
 * ones go back to it. SB_ERROR_ARGUMENT, _NOT_FINITE, _INDEX, _MEMORY, _MESH (empty, nothing left, or one-sided like a
 * Moebius strip): the mesh is as it was. */
SB_API sb_result sb_surface_repair(sb_mesh *mesh, const sb_surface_repair_def *def, sb_surface_repair_report *report,
                                   sb_error *error);

/* ---- shapes: what a mesh or a grid is made round ----------------------------------------------------------------- */

/* A shape as a function of space: negative inside, positive outside, 0 on the surface; m where it is a distance. It
 * must give the same value for the same point each time, also when called from several threads at once. */
typedef sb_real (*sb_distance)(void *user, sb_vec3 point);

/* The inside of something: of a surface, or of a function of one's own; one of the two. Zero-initialise. */
typedef struct sb_shape {
    const sb_surface *surface; /* or NULL, then `distance` is called. Borrowed for the call that takes the shape */
    sb_distance distance;
    void *user;        /* handed to `distance` */
    sb_real max_slope; /* of `distance`: |f(a) - f(b)| <= max_slope |a - b| for all a, b; 1 for true distances:
                        * then space far from the surface is not sampled. 0: unknown, every point is */
    int region;        /* of the elements inside */
} sb_shape;

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* doubtful[triangles] = 1 for those that cross others, or whose sides are not inside and outside: where one of them is
 * the nearest, only the winding number gives the sign. Returns 1 when triangles cross or may (then all are doubtful),
 * 0 when not (all are 0), -1: no memory. Some 2 us for each triangle, 10 us when they cross. */
SBI_API int sbi_surface_find_doubtful(const sb_surface *surface, unsigned char *doubtful);
/* *triangle: one of a part (of what shares nodes) that looks inward and is no cavity, or -1. Open surfaces: as far as
 * winding numbers give. 0: no memory. */
SBI_API int sbi_surface_find_inside_out(const sb_surface *surface, const sb_allocator *allocator, int *triangle);
#endif

#endif /* SB_SURFACE_H */
