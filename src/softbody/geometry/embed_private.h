/* embed_private: an embedding, and what its update and its transpose share. */
#ifndef SBI_EMBED_PRIVATE_H
#define SBI_EMBED_PRIVATE_H

#include "../base/lanes.h"
#include "embed.h"
#include "embed_search.h"

#include <limits.h>
#include <string.h>

/* Points are evaluated SBI_EMBED_LANES at a time, whole vectors of any machine; groups are padded to that. The other
 * sizes divide the work among threads and depend on nothing but the problem. */
enum {
    SBI_EMBED_LANES = 8,
    SBI_EMBED_GROUP = 256,      /* most points of a group */
    SBI_EMBED_TASK_GROUPS = 32, /* groups of a task */
    SBI_EMBED_TASK_FACES = 128,
    SBI_EMBED_TASK_NODES = 512,
    SBI_EMBED_TASK_RINGS = 2048,
    SBI_EMBED_TASK_BUILD = 256,
    SBI_EMBED_RING = 64 /* most triangles around a point whose ring is put in order */
};

#define SBI_EMBED_EACH_LANE(l) SBI_EACH_LANE(l, SBI_EMBED_LANES)

/* Rows of ascending items. */
typedef struct sbi_embed_lists {
    int rows;
    int *starts; /* [rows + 1] */
    int *items;
} sbi_embed_lists;

/* Points held in the same way by the same cell (an element, or a face for OFFSET and FRAME). Their slots lie in blocks
 * of SBI_EMBED_LANES; what the last one has too many repeats the last point. */
typedef struct sbi_embed_group {
    sb_embedding_hold hold;
    int cell;
    int count; /* 0: free */
    int first_block;
    int node_count;
    int next; /* of the same element, or -1 */
} sbi_embed_group;

/* What adds to nodes: a row of entries for each group, or for each face. Rows are used again when they are free. */
typedef struct sbi_embed_rows {
    int width, end, used, room; /* rows from `end` on are fresh; room counts all */
    int free_first;             /* chained by `next` of their first entries; -1 ends */
    uint64_t *order;            /* [room] the entries of a node follow each other in this order of their rows */
    int *nodes;                 /* [room][width]; the first is -1 in a free row */
    int *touched;               /* [room][width] index of the node among the touched ones */
    int *next;                  /* [room][width] next entry of the same node, or -1 */
    sb_vec3 *forces;            /* [room][width] scratch */
} sbi_embed_rows;

enum { SBI_EMBED_OF_GROUPS = 0, SBI_EMBED_OF_FACES = 1, SBI_EMBED_KINDS = 2 };

/* A node that has entries. */
typedef struct sbi_embed_touched {
    int node;                                          /* -1: free, and first[0] is the next free one */
    int normal_users;                                  /* entries of OFFSET groups: they need its smooth normal */
    int first[SBI_EMBED_KINDS], last[SBI_EMBED_KINDS]; /* its entries of groups and of faces, or -1 */
} sbi_embed_touched;

/* What updates read and write. Groups, blocks, faces and touched nodes lie in slots that are used again, so that a
 * change of the mesh costs what it changes. Which slot holds what depends on the past; results do not: sums run along
 * the lists of entries. */
typedef struct sbi_embed_arrays {
    int block_end, block_used, block_room, block_free; /* free ones are chained by block_next; -1 ends */
    int *block_next;                                   /* [block_room] next block of the same group */
    int *slot_point;                                   /* [block_room][SBI_EMBED_LANES] */
    sb_real *parameters[3];                            /* likewise: xi; OFFSET (r, s, d); FRAME (r, s) */
    sb_real *offsets[3];                               /* EXTRAPOLATED: step; FRAME: in the frame; NULL: never any */
    sb_real *carried[3];                               /* def.normals as cofactor coordinates, J^T N / det J; or NULL */

    sbi_embed_rows rows[SBI_EMBED_KINDS];
    sbi_embed_group *groups; /* of the rows of groups */
    int *element_groups;     /* [element_room] first group of an element, or -1 */
    int element_room;
    sb_vec3 *pulls;        /* [entry of groups] scratch: derivative with respect to the smooth normal */
    sb_real *face_weights; /* [entry of faces] angles (rad) */
    sb_vec3 *face_normals; /* [entry of faces] scratch: times the weights */

    int touched_end, touched_used, touched_room, touched_free;
    sbi_embed_touched *touched; /* [touched_room] */
    sb_vec3 *normals;           /* [touched_room] scratch: unit */
    sb_real *lengths;           /* [touched_room] scratch: of the sums that they are the directions of */
    sb_vec3 *normal_pulls;      /* [touched_room] scratch */
    int *touched_of;            /* [node_room] -1: it has no entries */
    int node_room;
} sbi_embed_arrays;

/* A point's place, as updates take it. */
typedef struct sbi_embed_place {
    sb_embedding_hold hold;
    int cell; /* element, or element * faces + local face */
    sb_real parameters[3], offset[3], carried[3];
    sb_real gap; /* distance to the mesh (m) */
} sbi_embed_place;

struct sbi_embed_follower;

struct sb_embedding {
    sb_allocator allocator;
    sb_element_type type;
    sb_embedding_kind kind;
    sb_embedding_report report;
    sb_embedded_point *points; /* [point_count] */
    int *elements;             /* the mesh's */
    sbi_embed_face face;
    sb_real scale;         /* largest coordinate of the mesh at creation (m) */
    sb_vec3 *rest;         /* [point_count] (m) */
    sb_vec3 *rest_normals; /* [point_count] def.normals, or NULL */
    int *order;            /* [point_count] along Morton's curve */
    unsigned char *inside; /* [point_count] 1: it was inside at creation */
    sbi_embed_lists rings; /* point -> its neighbours in order around it; ~index starts a new run */
    sbi_embed_arrays arrays;
    struct sbi_embed_follower *follower; /* of a body whose mesh changes: elements are in it; or NULL */
};

typedef struct sbi_embed_lanes {
    sb_real shape[SB_MAX_ELEMENT_NODES][SBI_EMBED_LANES];
    sb_real slope[SB_MAX_ELEMENT_NODES][3][SBI_EMBED_LANES];
} sbi_embed_lanes;

typedef struct sbi_embed_vec3 {
    sb_real x[SBI_EMBED_LANES], y[SBI_EMBED_LANES], z[SBI_EMBED_LANES];
} sbi_embed_vec3;

SB_INLINE sb_vec3 sbi_embed_lane(const sbi_embed_vec3 *v, int l) { return sb_v3(v->x[l], v->y[l], v->z[l]); }
SB_INLINE void sbi_embed_set_lane(sbi_embed_vec3 *v, int l, sb_vec3 value)
{
    v->x[l] = value.x;
    v->y[l] = value.y;
    v->z[l] = value.z;
}

/* x -> 1 / sqrt(x), x >= 0, to rounding: unlike sqrt it vectorises on every compiler. Any finite number for x = 0. */
SBI_FORCE_INLINE void sbi_embed_rsqrt(sb_real *x)
{
    sb_real y[SBI_EMBED_LANES];
#if SB_REAL_IS_FLOAT
    uint32_t bits[SBI_EMBED_LANES];
    const uint32_t magic = 0x5f3759dfu;
#else
    uint64_t bits[SBI_EMBED_LANES];
    const uint64_t magic = UINT64_C(0x5fe6eb50c7b537a9);
#endif
    memcpy(bits, x, sizeof bits);
    SBI_EMBED_EACH_LANE(l)
    bits[l] = magic - (bits[l] >> 1);
    memcpy(y, bits, sizeof y);
    SBI_EMBED_EACH_LANE(l)
    { /* relative errors 3e-2, 2e-3, 5e-6, 3e-11, 1e-16 */
        sb_real half = (sb_real)0.5 * x[l], z = y[l];
        z = z * ((sb_real)1.5 - half * z * z);
        z = z * ((sb_real)1.5 - half * z * z);
        z = z * ((sb_real)1.5 - half * z * z);
        x[l] = z * ((sb_real)1.5 - half * z * z);
    }
}

/* out = sum_a weight_a x_a; the weights of node a start at weight + a * stride. */
SBI_FORCE_INLINE void sbi_embed_sum(int count, const sb_real *weight, int stride, const sb_vec3 *x, sbi_embed_vec3 *out)
{
    sb_real sx[SBI_EMBED_LANES], sy[SBI_EMBED_LANES], sz[SBI_EMBED_LANES];
    SBI_EMBED_EACH_LANE(l)
    sx[l] = sy[l] = sz[l] = 0;
    for (int a = 0; a < count; a++) {
        const sb_real *w = weight + a * stride;
        SBI_EMBED_EACH_LANE(l)
        {
            sx[l] += w[l] * x[a].x;
            sy[l] += w[l] * x[a].y;
            sz[l] += w[l] * x[a].z;
        }
    }
    SBI_EMBED_EACH_LANE(l)
    {
        out->x[l] = sx[l];
        out->y[l] = sy[l];
        out->z[l] = sz[l];
    }
}

/* v / |v|, and 1 / |v|. */
SBI_FORCE_INLINE void sbi_embed_normalise(sbi_embed_vec3 *v, sb_real *inverse)
{
    SBI_EMBED_EACH_LANE(l)
    inverse[l] = v->x[l] * v->x[l] + v->y[l] * v->y[l] + v->z[l] * v->z[l];
    sbi_embed_rsqrt(inverse);
    SBI_EMBED_EACH_LANE(l)
    {
        v->x[l] *= inverse[l];
        v->y[l] *= inverse[l];
        v->z[l] *= inverse[l];
    }
}

/* v += s w */
SBI_FORCE_INLINE void sbi_embed_madd(sbi_embed_vec3 *v, const sb_real *s, const sbi_embed_vec3 *w)
{
    SBI_EMBED_EACH_LANE(l)
    {
        v->x[l] += s[l] * w->x[l];
        v->y[l] += s[l] * w->y[l];
        v->z[l] += s[l] * w->z[l];
    }
}

/* What a task of an update reads and writes. */
typedef struct sbi_embed_frame {
    sb_embedding *embedding;
    const sb_vec3 *x;
    sb_vec3 *points, *normals;
    const sb_vec3 *forces;
    sb_vec3 *node_forces;
} sbi_embed_frame;

/* A group's cell in this frame. */
typedef struct sbi_embed_cell {
    sb_element_type type;
    int count;
    sb_vec3 x[SB_MAX_ELEMENT_NODES];
    sb_vec3 normal[SB_MAX_FACE_NODES]; /* OFFSET */
} sbi_embed_cell;

SB_INLINE int sbi_embed_is_on_face(sb_embedding_hold hold)
{
    return hold == SB_EMBEDDED_OFFSET || hold == SB_EMBEDDED_FRAME;
}

SB_INLINE int sbi_embed_tasks(int count, int size) { return count / size + (count % size > 0); }

/* Allocates for the embedding; NULL (and *ok = 0) when memory is short. */
SBI_API void *sbi_embed_take(const sb_embedding *e, int *ok, size_t count, size_t size);
/* Rows of the indices i with keys[i] = row; keys < 0 belong to none. 0: no memory. */
SBI_API int sbi_embed_lists_make(const sb_embedding *e, const int *keys, int count, int rows, sbi_embed_lists *lists);
SBI_API void sbi_embed_lists_free(const sb_embedding *e, sbi_embed_lists *lists);

/* Places one point; *hint is an element nearby, and then the point's own. normal: NULL for none. */
SBI_API void sbi_embed_place_point(const sbi_embed_volume *volume, sb_embedding_kind kind, sb_vec3 point,
                                   const sb_vec3 *normal, int *hint, sbi_embed_place *place, sb_embedded_point *info);
/* How many points are held in this way. */
SBI_API int *sbi_embed_report_count(sb_embedding_report *report, sb_embedding_hold hold);
SBI_API void sbi_embed_report_add(sb_embedding_report *report, const sbi_embed_place *place, int index);

/* What the arrays of an update are made of: places, and the mesh that they are in. */
typedef struct sbi_embed_parts {
    const sbi_embed_place *places; /* of all points */
    int with_normals, with_offsets;
    int node_count, element_count, width, faces;
    const int *elements;    /* [element_count][width] */
    const int *outer;       /* [element_count][faces] row of weights of boundary faces, or -1 */
    const sb_real *weights; /* angles at their nodes (rad) */
    const sbi_embed_face *face;
    int local[6][SB_MAX_FACE_NODES]; /* nodes of each face of an element */
} sbi_embed_parts;
SBI_API void sbi_embed_fill_local(sb_element_type type, int local[6][SB_MAX_FACE_NODES]);

/* Groups, blocks, faces and nodes that come on top of those in use. */
typedef struct sbi_embed_more {
    int groups, blocks, faces, touched;
} sbi_embed_more;

/* Replaces an array of `used` items by one with room for more; 0: no memory, and it stays. */
SBI_API int sbi_embed_grow_array(const sb_allocator *allocator, void **array, size_t used, size_t room, size_t item);
/* Half as much again, so that what grows does not ask each time. */
SB_INLINE int sbi_embed_roomy(int needed) { return needed > INT_MAX / 2 ? needed : needed + needed / 2; }
/* Fills arrays, which are zeros before, with all points: order[count]. 0: no memory. */
SBI_API int sbi_embed_arrays_fill(const sb_allocator *allocator, sbi_embed_arrays *arrays, const sbi_embed_parts *parts,
                                  const int *order, int count);
/* Room for more. 0: no memory, and nothing has changed that can be seen. */
SBI_API int sbi_embed_arrays_reserve(const sb_allocator *allocator, sbi_embed_arrays *arrays,
                                     const sbi_embed_parts *parts, const sbi_embed_more *more);
SBI_API void sbi_embed_arrays_free(const sb_allocator *allocator, sbi_embed_arrays *arrays);

/* Nodes of a place's element or face; returns how many. */
SBI_API int sbi_embed_cell_nodes(const sbi_embed_parts *parts, sb_embedding_hold hold, int cell,
                                 int nodes[SB_MAX_ELEMENT_NODES]);
/* Lists the points of a group; returns how many. */
SBI_API int sbi_embed_list_points(const sbi_embed_arrays *arrays, const sbi_embed_group *group, int *points);
/* Makes groups of points, which lie next to those of the same hold and cell; whoever is there has all its points. */
SBI_API void sbi_embed_add_groups(sbi_embed_arrays *arrays, const sbi_embed_parts *parts, const int *points, int count);
/* Removes the group that *link names, and lets *link name the next of its element. */
SBI_API void sbi_embed_drop_group(sbi_embed_arrays *arrays, int *link);
/* Removes the faces of which a node is one. */
SBI_API void sbi_embed_drop_faces(sbi_embed_arrays *arrays, int node);
/* Adds a face (element * faces + local face) where it is an outer one and smooth normals need it. */
SBI_API void sbi_embed_add_face(sbi_embed_arrays *arrays, const sbi_embed_parts *parts, int face);

SBI_API void sbi_embed_cell_gather(const sb_embedding *e, const sbi_embed_group *group, const sb_vec3 *x,
                                   sbi_embed_cell *cell);
/* Shape functions at the slots from `slot`; those of EXTRAPOLATED points become the weights of their nodes. */
SBI_API void sbi_embed_slot_shape(const sb_embedding *e, sb_embedding_hold hold, sb_element_type type, int count,
                                  int slot, int slopes, sbi_embed_lanes *lanes);
/* The frame of a face with tangents a and b: along a, across, normal. Zero vectors where it has none. */
SBI_API sb_mat3 sbi_embed_face_frame(sb_vec3 a, sb_vec3 b);
/* Tangents of the cell (d/dr, d/ds, and d/dt of elements). */
SBI_API void sbi_embed_tangents(const sbi_embed_cell *cell, const sbi_embed_lanes *lanes, sbi_embed_vec3 tangent[3]);
/* Smooth normals at frame->x. */
SBI_API void sbi_embed_make_normals(sbi_embed_frame *frame, const sb_jobs *jobs);

#endif /* SBI_EMBED_PRIVATE_H */
