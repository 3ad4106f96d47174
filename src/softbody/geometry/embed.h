/* embed: points and surfaces carried along by a volume mesh, and forces on them brought back. Floor 2.
 *
 * How a point is held. Inside the mesh it is (element, xi) and moves as x(xi) = sum_a N_a(xi) x_a. A drawn surface is
 * finer than the mesh, so many of its vertices lie a little outside. Such a point is x(r, s) + d n(r, s): a place on a
 * boundary face and a distance along the smooth normal n = m / |m|, m = sum_I N_I nbar_I, of unit nodal normals nbar_I.
 * These are made anew from the positions each frame, as mean of the normals of the faces around a node weighted by
 * their angles at rest. So the map is continuous over edges and faces, needs no stored rotations, and is a function of
 * the node positions alone: rigid motions are reproduced exactly, and the transpose for forces is exact and keeps force
 * and moment. Where no such place is to be had (a deep fold, close to a centre of curvature), the point keeps its
 * closest face point and its offset in that face's frame (tangent, normal), which is still exact for rigid motions.
 *
 * The closest point is global: a walk through the mesh finds a candidate, and a tree of boxes rules out every element
 * that could be closer. A walk alone may end in the wrong lobe of an organ. */
#ifndef SB_EMBED_H
#define SB_EMBED_H

#include "../fem/domain.h"

typedef enum sb_embedding_kind {
    SB_EMBED_SMOOTH = 0, /* as above */
    SB_EMBED_PLAIN = 1   /* (element, xi); points outside extrapolate linearly from their closest point: exact for
                          * affine motions, shears and bends show at the edges of elements */
} sb_embedding_kind;

/* How a point is held. */
typedef enum sb_embedding_hold {
    SB_EMBEDDED_INSIDE = 0,      /* x(xi) */
    SB_EMBEDDED_OFFSET = 1,      /* x + d n, n the smooth normal */
    SB_EMBEDDED_FRAME = 2,       /* x + offset in the frame of the face: the fallback */
    SB_EMBEDDED_EXTRAPOLATED = 3 /* x + dx/dxi step: outside with SB_EMBED_PLAIN, or closest to no outer face */
} sb_embedding_hold;

typedef struct sb_embedding_def {
    const sb_mesh *mesh;   /* tet4, tet10, hex8, hex20 or hex27 at rest, as sb_mesh_validate accepts it. Read at
                            * creation only */
    const sb_vec3 *points; /* [point_count] points at rest (m); NULL: the nodes of surface */
    int point_count;
    const sb_mesh *surface; /* tri3 or quad4 whose nodes are the points, or NULL. Gives normals */
    const sb_vec3 *normals; /* [point_count] normals at rest, of any length, or NULL. Given, they are carried along
                             * instead of being made from the surface */
    sb_embedding_kind kind; /* SB_EMBED_SMOOTH */
    sb_real max_distance;   /* m; a point farther outside is refused. SB_REAL_MAX: none is */
    sb_allocator allocator; /* zeros: malloc */
    sb_jobs jobs;           /* threads for the creation; zeros: none */
    unsigned cookie;        /* set by sb_default_embedding_def */
} sb_embedding_def;
SB_API sb_embedding_def sb_default_embedding_def(void);

typedef struct sb_embedding sb_embedding;

/* Embeds points in a mesh. SB_ERROR_ARGUMENT (a field out of range, a point beyond max_distance: error->node),
 * SB_ERROR_NOT_FINITE (error->node: the point), SB_ERROR_UNSUPPORTED for custom elements, what sb_mesh_validate says of
 * the mesh, SB_ERROR_INDEX for the surface, SB_ERROR_MEMORY; *embedding is then untouched. Copies what it keeps. About
 * 2 microseconds for each point of a tet mesh on one thread; the result does not depend on the threads. Release with
 * sb_embedding_destroy. */
SB_API sb_result sb_embedding_create(const sb_embedding_def *def, sb_embedding **embedding, sb_error *error);
SB_API void sb_embedding_destroy(sb_embedding *embedding); /* NULL is fine */

/* Where the points are when the nodes of the mesh are at node_positions (m), such as sb_body_positions(body):
 * points[point_count], and unless NULL unit normals[point_count]. node_positions: [node_count of
 * sb_embedding_get_report], which is mesh.node_count, or the slots of the body that it follows. After a change of the
 * body's mesh (sb_body_change_commit), as needles make, the points are wrong unless the embedding follows it
 * (sb_embedding_follow). Normals are
 * - with a surface, of its deformed triangles (quads: corner triangles) around each point, weighted by area: those of
 *   what is drawn. Zero for a point without triangles;
 * - with def.normals, F^-T N of the embedding's deformation gradient F at the point: no neighbours needed, but it jumps
 *   a little where F does, between elements.
 * SB_ERROR_ARGUMENT for a NULL array, or normals without either source; nothing is written. Positions that are not
 * finite give points that are not. Output arrays must not overlap node_positions. Allocates nothing, but after a state
 * was loaded without memory for it (SB_ERROR_MEMORY, see sb_embedding_follow); the same bits for any number of threads;
 * one call at a time for each embedding. jobs: NULL for none. */
SB_API sb_result sb_embedding_update(sb_embedding *embedding, const sb_vec3 *node_positions, sb_vec3 *points,
                                     sb_vec3 *normals, const sb_jobs *jobs);

/* Adds to node_forces[mesh.node_count] (N) the forces equivalent to point_forces[point_count] (N) at node_positions:
 * the exact transpose of sb_embedding_update's derivative, with the same net force and moment. What is said there of
 * allocation, threads and errors holds. */
SB_API sb_result sb_embedding_forces(sb_embedding *embedding, const sb_vec3 *node_positions,
                                     const sb_vec3 *point_forces, sb_vec3 *node_forces, const sb_jobs *jobs);

/* ---- what it found ---- */

typedef struct sb_embedding_report {
    int point_count, node_count;
    int inside, offset, frame, extrapolated; /* points held in each way; their sum is point_count */
    int lost;                                /* see sb_embedded_point */
    sb_real max_distance;                    /* largest distance of a point outside from the mesh (m) */
    int farthest_point;                      /* its index, or -1 when all are inside */
} sb_embedding_report;
SB_API sb_embedding_report sb_embedding_get_report(const sb_embedding *embedding);

/* How one point is held, at rest. */
typedef struct sb_embedded_point {
    sb_embedding_hold hold;
    int element;
    sb_real xi[3];    /* where it is in the element; for points outside their foot or closest point there */
    sb_real distance; /* from there (m); 0 inside */
    sb_real step[3];  /* point = x(xi) + dx/dxi step: its offset in the parameters of the element; 0 inside */
    int lost; /* 1: it was inside at creation and is outside now: a change of the mesh (sb_embedding_follow) took
               * the cell that it was in, or moved the surface past it */
} sb_embedded_point;
/* SB_ERROR_INDEX for no such point; *point is then untouched. */
SB_API sb_result sb_embedding_get_point(const sb_embedding *embedding, int index, sb_embedded_point *point);

/* Rows of node weights for all points, for sb_body_add_mapping: landmarks that pull, measured targets. A row is the
 * point itself for one held inside or extrapolated, else its linear extrapolation from the element: right at rest and
 * for affine motions. Weights sum to 1. */
typedef struct sb_embedding_rows {
    sb_mapping mapping; /* of the arrays below */
    int *row_start, *nodes;
    sb_real *weights;
    sb_allocator allocator;
} sb_embedding_rows;
/* SB_ERROR_MEMORY, SB_ERROR_ARGUMENT; *rows is then untouched. A NULL allocator means malloc. */
SB_API sb_result sb_embedding_mapping(const sb_embedding *embedding, const sb_allocator *allocator,
                                      sb_embedding_rows *rows, sb_error *error);
SB_API void sb_embedding_rows_free(sb_embedding_rows *rows); /* {0} and NULL are fine */

#endif /* SB_EMBED_H */
