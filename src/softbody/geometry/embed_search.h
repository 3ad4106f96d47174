/* embed_search: where a point lies in a volume mesh: the closest element, and the way to it along smooth normals.
 * Internal to embed, floor 2. */
#ifndef SB_EMBED_SEARCH_H
#define SB_EMBED_SEARCH_H

#include "../mesh/mesh.h"

/* Face nodes, padded so that loops over them run in whole vectors. */
enum { SBI_EMBED_FACE_LANES = 12 };

/* A face type and its shape functions' slopes at its nodes: the tangents at node i are sum_j slope[k][j][i] x_j. */
typedef struct sbi_embed_face {
    sb_element_type type;
    int nodes, corners, lanes; /* lanes: nodes rounded up to a multiple of 4 */
    sb_real slope[2][SB_MAX_FACE_NODES][SBI_EMBED_FACE_LANES];
} sbi_embed_face;

SBI_API void sbi_embed_face_make(sb_element_type type, sbi_embed_face *face);
/* Unit normals (zero where the face has none) times weight[i] at the nodes of a face at x. */
SBI_API void sbi_embed_face_normals(const sbi_embed_face *face, const sb_vec3 *x, const sb_real *weight, sb_vec3 *out);
/* Angle of a face at its node i (rad): between its edges at a corner, pi on an edge, the whole turn inside. */
SBI_API sb_real sbi_embed_face_angle(const sbi_embed_face *face, const sb_vec3 *x, int i);
/* v / |v|; zero for a vector too short to have a direction. */
SB_INLINE sb_vec3 sbi_embed_unit(sb_vec3 v)
{
    sb_real square = sb_v3_dot(v, v);
    return square > 0 ? sb_v3_scale((sb_real)1 / sb_sqrt(square), v) : sb_v3(0, 0, 0);
}

typedef struct sbi_embed_box {
    sb_vec3 low, high;
} sbi_embed_box;

/* What queries read; nothing of it changes, so they may run on any number of threads. */
typedef struct sbi_embed_volume {
    sb_allocator allocator;
    const sb_mesh *mesh;
    int width, corners, faces;
    int is_box;                     /* hexes: parameters in [-1, 1]^3; else barycentric coordinates */
    sb_real scale;                  /* largest coordinate (m): rounding errors are epsilon times this */
    sb_boundary boundary;           /* with the nodes of the volume */
    sb_index_table neighbours;      /* of elements across their faces */
    sb_index_table face_neighbours; /* of boundary faces across their edges */
    int *boundary_face;             /* [elements][faces] or -1 */
    sb_real (*planes)[4][4]; /* [elements] tets: L_a(v) = p[0..2] . v + p[3] of the straight element; else NULL */
    sb_real *bulge;          /* [elements] how far the element may lie from its straight one (m) */
    int leaf_first;          /* index of the first leaf box; box i has the children 2 i + 1 and 2 i + 2 */
    int *order;              /* [elements] as the leaves hold them, SBI_EMBED_LEAF each */
    sbi_embed_box *boxes;
    sbi_embed_face face;
    sb_real *weights; /* [boundary faces][face nodes] angle at the node (rad) */
    sb_vec3 *normals; /* [nodes] smooth unit normals of the boundary; zero inside */
} sbi_embed_volume;

/* Elements of a leaf of the tree; deepest path through it. */
enum { SBI_EMBED_LEAF = 1, SBI_EMBED_DEPTH = 64 };

typedef enum sbi_embed_skin {
    SBI_EMBED_NO_SKIN = 0, /* closest elements only: boundary_face is -1 throughout and for the caller to fill, and what
                            * else is of the boundary is empty */
    SBI_EMBED_SKIN = 1,
    SBI_EMBED_BARE = 2 /* as without a skin, for points inside: no neighbours either. The boxes say where to start, and
                        * of points outside any closest element may be found */
} sbi_embed_skin;

/* Prepares queries of a volume mesh that sb_mesh_validate accepts; it is borrowed. */
SBI_API sb_result sbi_embed_volume_create(const sb_mesh *mesh, sbi_embed_skin skin, const sb_allocator *allocator,
                                          sbi_embed_volume *volume, sb_error *error);
SBI_API void sbi_embed_volume_free(sbi_embed_volume *volume);

/* Sorts count points along Morton's curve through their bounding box: order[count] receives their indices. scratch:
 * memory for 3 count 32-bit numbers. */
SBI_API void sbi_embed_sort(const sb_vec3 *points, int count, int *order, uint32_t *scratch);

/* The point of the mesh closest to a query point. */
typedef struct sbi_embed_hit {
    int element;
    sb_real xi[3];
    unsigned active;   /* bit f: it lies on face f of the element */
    sb_real distance2; /* m^2 */
} sbi_embed_hit;

/* Globally closest; `hint` is an element to start from. hit->distance2 is 0 for a point inside (to rounding), and xi
 * is then polished to solve x(xi) = point. */
SBI_API void sbi_embed_closest(const sbi_embed_volume *volume, sb_vec3 point, int hint, sbi_embed_hit *hit);

/* A point as x(r, s) + distance n(r, s) of a boundary face and its smooth normal. */
typedef struct sbi_embed_foot {
    int face;
    sb_real r, s, distance;
} sbi_embed_foot;

/* Solves for the foot of a point outside from its closest point, stepping over edges. 0 when there is none nearby. */
SBI_API int sbi_embed_find_foot(const sbi_embed_volume *volume, sb_vec3 point, const sbi_embed_hit *hit,
                                sbi_embed_foot *foot);
/* The closest point as a point of a boundary face, or face -1 when it lies on none. */
SBI_API sbi_embed_foot sbi_embed_hit_foot(const sbi_embed_volume *volume, const sbi_embed_hit *hit);
/* The map (r, s, d) -> x + d n at a foot and its Jacobian; 0 (nothing to rely on) where it has no normal or folds. */
SBI_API int sbi_embed_foot_map(const sbi_embed_volume *volume, const sbi_embed_foot *foot, sb_vec3 *at,
                               sb_mat3 *jacobian);
/* x(r, s) of a foot, and its tangents x_,r and x_,s. */
SBI_API sb_vec3 sbi_embed_foot_tangents(const sbi_embed_volume *volume, const sbi_embed_foot *foot,
                                        sb_vec3 tangents[2]);
/* Element and its parameters of a point of a boundary face. */
SBI_API int sbi_embed_foot_element(const sbi_embed_volume *volume, const sbi_embed_foot *foot, sb_real xi[3]);
/* x(xi) of an element and its Jacobian's columns. */
SBI_API sb_vec3 sbi_embed_map(const sb_mesh *mesh, int element, const sb_real xi[3], sb_mat3 *jacobian);

/* Nodes of a boundary face. */
SBI_API const int *sbi_embed_face_row(const sbi_embed_volume *volume, int face);
/* to[i] = from[nodes[i]] */
SBI_API void sbi_embed_gather(const sb_vec3 *from, const int *nodes, int count, sb_vec3 *to);

#endif /* SB_EMBED_SEARCH_H */
