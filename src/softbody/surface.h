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

#include "mesh.h"

/* A surface of triangles with its tree of boxes, made by sb_surface_create; independent of the mesh it was made of. */
typedef struct sb_surface sb_surface;

/* Where on its triangle a point lies. */
typedef enum sb_surface_feature {
    SB_SURFACE_FACE = 0,
    SB_SURFACE_EDGE = 1,  /* edge i joins corners i and i + 1 (2: corners 2 and 0) */
    SB_SURFACE_VERTEX = 2 /* corner i */
} sb_surface_feature;

/* What a query found. Without a find (result 0) triangle and element are -1, the distance is infinite and the rest 0. */
typedef struct sb_surface_hit {
    int triangle;               /* in [0, sb_surface_triangle_count) */
    int element;                /* of the mesh: the triangle's, or the face that was cut into triangles */
    sb_surface_feature feature; /* which kind of place on the triangle, and with `index` which of them */
    int index;                  /* edge or corner, 0 for a face */
    sb_vec3 point;              /* m, on the surface */
    sb_real weights[3];         /* of the triangle's corners, >= 0 up to rounding, sum 1: point = sum weight_i corner_i */
    sb_real distance;           /* m; rays: from the origin along the ray. Signed distance queries: with its sign */
} sb_surface_hit;

/* ---- life ------------------------------------------------------------------------------------------------------ */

/* Makes a surface of a mesh of tri3, tri6, quad4, quad8 or quad9; faces other than tri3 are cut into flat triangles
 * between their nodes. Nodes are copied. Surfaces that are open, touch themselves or have degenerate triangles are
 * welcome (scans are like that): sb_surface_check tells, and each query below says what it then means. One block of
 * memory from `allocator` (NULL: malloc) for everything, plus scratch that goes back; about 60 ms for 100,000
 * triangles. SB_ERROR_ARGUMENT (null pointer, a mesh of volumes: take sb_mesh_boundary), _MESH (empty, or too many
 * triangles), _NOT_FINITE, _INDEX, _MEMORY; then *surface is untouched. */
SB_API sb_result sb_surface_create(const sb_mesh *mesh, const sb_allocator *allocator, sb_surface **surface,
                                   sb_error *error);
SB_API void sb_surface_destroy(sb_surface *surface); /* accepts NULL */

/* Moves the nodes to nodes[sb_surface_node_count] (m) and refits boxes, normals and far fields in one pass over the
 * triangles, in parallel on `jobs` (NULL: inline). The tree keeps its shape: answers stay right however far the surface
 * deforms, and stay fast as long as neighbours stay near each other. Closest points, rays and signs are those of a new
 * surface, to the bit. Allocates nothing. SB_ERROR_ARGUMENT or _NOT_FINITE (error->node): nothing has changed. */
SB_API sb_result sb_surface_move(sb_surface *surface, const sb_vec3 *nodes, const sb_jobs *jobs, sb_error *error);

/* ---- what it is made of (0 or {0} for NULL) -------------------------------------------------------------------- */

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
 * twice the time. */
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

#endif /* SB_SURFACE_H */
