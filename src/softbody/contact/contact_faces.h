/* contact_faces: the faces of a body that contact acts on, and the samples on them. Internal.
 *
 * They are the boundary faces of the mesh, and their nodes its nodes; or the triangles of a skin (contact_skin.h),
 * whose nodes are its points. Then `nodes`, node_room and node_areas are of points, and there is one face of each
 * triangle, with that number.
 *
 * Faces are numbered in the order of their cells and of the cells' sides, whatever happened before, so that sums over
 * faces have the bits of a body made with its mesh. Where the mesh changes, numbers do: see sbi_contact_faces_update.
 * Samples are not stored: a face cut into n parts a side has those of its type's rule for n, which is made once.
 *
 *     type           samples of n parts a side                     parts no longer than   n
 *     tri3           n^2: centroids of equal triangles             r / 2                  2 .. 16
 *     tri6           3 n^2: the 3-point rule of each triangle      r                      1 .. 8
 *     quad4, 8, 9    4 n^2: 2 x 2 Gauss points of each cell        0.85 r                 1 .. 8
 *
 * Small triangles of a skin have one sample where organs touch (n = 1).
 *
 * r is the smallest radius of the tool. Any point of a flat face then has a sample within 0.35 r, and sums over samples
 * are exact for what a uniform pressure gives the nodes of a flat face with straight edges: linear functions (tri3),
 * quadratic ones (tri6), biquadratic ones times the face's linear Jacobian (quads). Centroids would not be: they leave
 * -1/(9 n^2) of a tri6 at each corner where nothing belongs, and miss the Jacobian of a quad that is no parallelogram.
 */
#ifndef SB_CONTACT_FACES_H
#define SB_CONTACT_FACES_H

#include "../body/body.h"
#include "../mesh/mesh_change.h"
#include "face_tree.h"

enum { SBI_CONTACT_MOST_PARTS = 16 };

/* Samples of a face type with n parts a side. */
typedef struct sbi_contact_rule {
    int count;        /* samples */
    sb_real measure;  /* of each, in the face's parameters */
    sb_real *weights; /* [count][nodes] shape functions at the samples: they sum to 1 */
    sb_real *slopes;  /* [count][2][nodes] their derivatives by both parameters */
    sb_real spread;   /* most that the weights of a sample sum to without their signs */
} sbi_contact_rule;

/* A face type; nodes 0: no face is of it. */
typedef struct sbi_contact_kind {
    sb_element_type type;
    int nodes, corners;
    int least, most;                   /* parts a side for tools; there are rules from 1 on */
    sb_real part;                      /* longest part, as a share of the tool's radius */
    sb_real shares[SB_MAX_FACE_NODES]; /* of a quadratic face's area that are its nodes' */
    sbi_contact_rule rules[SBI_CONTACT_MOST_PARTS + 1];
} sbi_contact_kind;

/* A side of an element. */
typedef struct sbi_contact_side {
    int nodes, corners;
    int local[SB_MAX_FACE_NODES];
} sbi_contact_side;

/* Scratch for the order of faces in the tree. */
typedef struct sbi_contact_order {
    sb_vec3 *centres;   /* [faces] */
    uint32_t *scratch;  /* [faces][3] */
    int *faces, *order; /* [faces] */
} sbi_contact_order;

typedef enum sbi_contact_news {
    SBI_CONTACT_CURRENT = 0,
    SBI_CONTACT_CHANGED = 1, /* `outer` is right, the faces are those before */
    SBI_CONTACT_STALE = 2    /* the whole mesh is another */
} sbi_contact_news;

/* What is kept of a mesh that may change; zeros of one that may not. */
typedef struct sbi_contact_live {
    int cell_room;
    sbi_contact_news news;
    int outer_count;
    unsigned char *outer;  /* [cell_room][sides of a cell] 1: a face of the surface */
    unsigned char *gone;   /* [cell_room] 1: removed since the last update, and perhaps made again */
    unsigned char *near;   /* [node_room] zeros between calls */
    int seen_count, *seen; /* [face_room] keys at the last update */
    int *moved;            /* [face_room] see sbi_contact_faces_update */
    sbi_contact_order order;
} sbi_contact_live;

typedef struct sbi_contact_faces {
    sb_allocator allocator;
    const sb_vec3 *points; /* of a skin: where its points are at rest (m), lent; NULL: nodes are the body's */
    int is_skin;
    int face_end;             /* faces are numbered below */
    int flat_count;           /* without area: they have no samples, and no query finds them */
    int face_room, node_room; /* that arrays by face and by node have */
    int width;                /* nodes per face in `nodes`: most of any face */
    unsigned char *sizes;     /* nodes of each face */
    int *nodes;               /* [face][width] counter-clockwise seen from outside */
    int *keys;                /* elements[face] * side_count + sides[face]: ascending */
    int *elements;            /* the cell behind it */
    unsigned char *sides;     /* its number among the faces of that cell */
    int *regions;             /* index of its material in the body */
    int region_count;         /* materials, also of cells that have no face yet */
    sb_real *areas;           /* m^2 at rest */
    sb_real *lengths;         /* m at rest: what is cut into parts, see sbi_contact_face_parts */
    int *blocks;              /* [face][width * width] once they were asked for */
    int *versions;            /* pattern that the blocks are of; -1: of none */
    sb_real *node_areas;      /* [node_room] (m^2), see sbi_contact_node_area */
    int side_count;           /* of a cell */
    sbi_contact_side element_sides[SB_MAX_ELEMENT_FACES];
    sbi_contact_kind kinds[SB_MAX_FACE_NODES + 1]; /* by the nodes of a face */
    sbi_face_tree tree;
    uint64_t *marks; /* zeros between queries */
    sbi_contact_live live;
    void *memory, *rule_memory;
} sbi_contact_faces;

/* The boundary faces of a body's mesh, with boxes at its present place. SB_ERROR_MESH: none of them has an
 * area. SB_ERROR_MEMORY (also when there are more than 2^31-1 places). allocator NULL: malloc. On failure *faces is
 * untouched. */
SBI_API sb_result sbi_contact_faces_create(const sb_body *body, const sb_allocator *allocator,
                                           sbi_contact_faces **faces, sb_error *error);
SBI_API void sbi_contact_faces_destroy(sbi_contact_faces *faces); /* NULL is fine */

/* Faces of a skin, yet to be filled: room for so many faces and points. */
SBI_API sb_result sbi_contact_faces_create_skin(const sb_body *body, const sb_allocator *allocator, int face_room,
                                                int point_room, sbi_contact_faces **faces, sb_error *error);
/* Fills them, and their tree; a refit has to follow. triangles [count], there is room; cells [points] that points lie
 * in, -1: none; points as the field, which is set to it. SB_ERROR_MESH: none has an area. */
SBI_API sb_result sbi_contact_faces_fill_skin(sbi_contact_faces *faces, const sb_body *body, const int (*triangles)[3],
                                              int count, const int *cells, const sb_vec3 *points, sb_error *error);

/* ---- following a mesh that changes (def.slack > 0): to be called by a listener of the body (sb_body_listen) ---- */
/* Takes the memory that following needs: a change that fails for it leaves the faces as they are. */
SBI_API sb_result sbi_contact_faces_reserve(sbi_contact_faces *faces, const sb_body *body, const sb_mesh_change *change,
                                            sb_error *error);
/* The change happened; NULL: the whole mesh is another. Cannot fail. Faces are out of date until the next update. */
SBI_API void sbi_contact_faces_follow(sbi_contact_faces *faces, const sb_body *body, const sb_mesh_change *change);
/* Brings the faces up to date; a refit has to follow. *changed (may be NULL): 1 when numbers may be others now: face f
 * of the last time is faces->live.moved[f], or -1 when its cell was removed (and perhaps another made in its place) or
 * it is none of the surface any more. Those that stay keep their order. Takes memory only where the whole mesh was
 * another: SB_ERROR_MEMORY, SB_ERROR_MESH (no face has an area) leave the faces without use until it succeeds. */
SBI_API sb_result sbi_contact_faces_update(sbi_contact_faces *faces, const sb_body *body, int *changed,
                                           sb_error *error);

/* ---- boxes, samples, blocks ---- */
/* Boxes anew, for the way from x to x + dt v (m); v NULL: at x. */
SBI_API void sbi_contact_faces_refit(sbi_contact_faces *faces, const sb_vec3 *x, const sb_vec3 *v, sb_real dt);
/* Faces whose boxes meet [low, high] (m): returns how many, and writes the first `capacity` of them, ascending. One
 * thread at a time. */
SBI_API int sbi_contact_faces_query(sbi_contact_faces *faces, sb_vec3 low, sb_vec3 high, int *found, int capacity);

/* Parts a side of a face for a tool of radius r (m): a constant of the two, so that no sample comes or goes. */
SBI_API int sbi_contact_face_parts(const sbi_contact_faces *faces, int face, sb_real radius);
/* As many, or what the face with its nodes at x needs to have as close samples where it is stretched. */
SBI_API int sbi_contact_stretched_parts(const sbi_contact_faces *faces, int face, const sb_vec3 *x, sb_real radius);
/* Smallest radius (m) that no face needs more parts for than there are rules; *face (may be NULL): which needs most. */
SBI_API sb_real sbi_contact_faces_thinnest(const sbi_contact_faces *faces, int *face);
/* Area of a sample (m^2 at rest). */
SBI_API sb_real sbi_contact_sample_area(const sbi_contact_faces *faces, const sb_body *body, int face, int parts,
                                        int sample);
/* [nodes][nodes] positions of the face's blocks in the body's matrix as it is now, valid until the next change of its
 * pattern. Found when they are first asked for: one thread at a time. Not of a skin, which keeps something else there
 * (contact_skin_blocks.c). */
SBI_API const int *sbi_contact_face_blocks(sbi_contact_faces *faces, const sb_body *body, int face);

SB_INLINE const int *sbi_contact_face_nodes(const sbi_contact_faces *faces, int face)
{
    return faces->nodes + (size_t)face * (size_t)faces->width;
}
SB_INLINE sb_element_type sbi_contact_face_type(const sbi_contact_faces *faces, int face)
{
    return faces->kinds[faces->sizes[face]].type;
}
SB_INLINE const sbi_contact_rule *sbi_contact_face_rule(const sbi_contact_faces *faces, int face, int parts)
{
    return &faces->kinds[faces->sizes[face]].rules[parts];
}
/* [nodes of the face] shape functions at a sample. */
SB_INLINE const sb_real *sbi_contact_sample_weights(const sbi_contact_faces *faces, int face, int parts, int sample)
{
    return sbi_contact_face_rule(faces, face, parts)->weights + (size_t)sample * (size_t)faces->sizes[face];
}
/* Area of the surface that is a node's (m^2 at rest), 0 off the surface: the integral of its shape function; of
 * quadratic faces, where that is zero (tri6) or negative (quad8) at corners, its share of the integrals of all |N|,
 * times the area. Their sum is the area. */
SB_INLINE sb_real sbi_contact_node_area(const sbi_contact_faces *faces, int node) { return faces->node_areas[node]; }

/* ---- what the sources of this room share ---- */
/* Kinds, sides and rules of an element's faces. 0: no memory. */
SBI_API int sbi_contact_make_rules(sbi_contact_faces *faces, sbi_element element);
SBI_API const int *sbi_contact_cell_nodes(const sb_body *body, int cell);
/* 1 when the corners of a cell's side run through it the way round in which the second least follows the least: of two
 * sides that touch, one does. */
SBI_API int sbi_contact_side_ascends(const sbi_contact_side *side, const int *nodes);
/* Rooms, arrays, faces and tree of a body from nothing. */
SBI_API sb_result sbi_contact_fill(sbi_contact_faces *faces, const sb_body *body, sb_error *error);
/* Arrays and tree for the rooms there are. 0: no memory. */
SBI_API int sbi_contact_take_arrays(sbi_contact_faces *faces);
SBI_API int sbi_contact_take_tree(sbi_contact_faces *faces, int nodes);
SBI_API void sbi_contact_release_arrays(sbi_contact_faces *faces);
/* As many nodes as the faces that there is room for can have. */
SBI_API int sbi_contact_most_nodes(const sbi_contact_faces *faces);
/* Faces from what is outside, and the tree of those with area: along Morton's curve through their corners' centres. */
SBI_API void sbi_contact_put_faces(sbi_contact_faces *faces, const sb_body *body, const unsigned char *outer);
SBI_API void sbi_contact_build_tree(sbi_contact_faces *faces, const sb_body *body, const sbi_contact_order *order);

#endif /* SB_CONTACT_FACES_H */
