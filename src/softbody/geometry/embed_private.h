/* embed_private: an embedding, and what its update and its transpose share. */
#ifndef SBI_EMBED_PRIVATE_H
#define SBI_EMBED_PRIVATE_H

#include "embed.h"
#include "embed_search.h"

#include <limits.h>
#include <string.h>

/* Points are evaluated SBI_EMBED_LANES at a time, whole vectors of any machine; groups are padded to that. The other
 * sizes divide the work among threads and depend on nothing but the problem. */
enum {
    SBI_EMBED_LANES = 8,
    SBI_EMBED_GROUP = 256,       /* most points of a group */
    SBI_EMBED_TASK_SLOTS = 1024, /* points of a task */
    SBI_EMBED_TASK_FACES = 128,
    SBI_EMBED_TASK_NODES = 512,
    SBI_EMBED_TASK_RINGS = 2048,
    SBI_EMBED_TASK_BUILD = 256,
    SBI_EMBED_RING = 64 /* most triangles around a point whose ring is put in order */
};

/* gcc would unroll a loop over lanes before it can see vectors in it, and then spill what it unrolled. */
#if defined(__GNUC__) && !defined(__clang__)
#define SBI_EMBED_EACH_LANE(l) _Pragma("GCC unroll 1") for (int l = 0; l < SBI_EMBED_LANES; l++)
#else
#define SBI_EMBED_EACH_LANE(l) for (int l = 0; l < SBI_EMBED_LANES; l++)
#endif

/* Rows of ascending items. */
typedef struct sbi_embed_lists {
    int rows;
    int *starts; /* [rows + 1] */
    int *items;
} sbi_embed_lists;

/* Points held in the same way by the same cell (an element, or a face for OFFSET and FRAME). */
typedef struct sbi_embed_group {
    sb_embedding_hold hold;
    int first, count;           /* slots; first is a multiple of SBI_EMBED_LANES */
    int node_first, node_count; /* in sb_embedding.nodes */
} sbi_embed_group;

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
    struct sbi_embed_follower
        *follower; /* of a body whose mesh changes: the arrays from here on and elements are in it; or NULL */

    int group_count, task_count, slot_count;
    sbi_embed_group *groups;
    int *tasks;             /* [task_count + 1] first group of each */
    int *slot_point;        /* [slot_count]; padding repeats the last point of its group */
    sb_real *parameters[3]; /* [slot_count] xi; OFFSET (r, s, d); FRAME (r, s) */
    sb_real *offsets[3];    /* [slot_count] EXTRAPOLATED: step; FRAME: offset in the frame; NULL when none is */
    sb_real *carried[3];    /* [slot_count] def.normals as cofactor coordinates, J^T N / det J; or NULL */

    /* Node entries: those of the groups, then those of the faces whose normals they need. */
    int group_entries, entry_count, face_count, normal_count, touched_count;
    int *nodes;                    /* [entry_count] */
    int *normal_of;                /* [entry_count] the smooth normal there, or -1 */
    sb_real *weights;              /* [face_count][face nodes] */
    sbi_embed_lists normal_faces;  /* smooth normal -> entries of its faces, counted from the first of them */
    sbi_embed_lists normal_groups; /* smooth normal -> entries of groups */
    sbi_embed_lists touched;       /* touched node -> entries */
    int *touched_nodes;            /* [touched_count] */
    sbi_embed_lists rings;         /* point -> its neighbours in order around it; ~index starts a new run */

    /* scratch of updates */
    sb_vec3 *face_normals; /* [face_count][face nodes] */
    sb_vec3 *normals;      /* [normal_count] unit */
    sb_real *lengths;      /* [normal_count] of the sums that they are the directions of */
    sb_vec3 *entry_forces; /* [entry_count] */
    sb_vec3 *entry_pulls;  /* [group_entries] derivative with respect to the smooth normal */
    sb_vec3 *normal_pulls; /* [normal_count] */
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
SBI_API void sbi_embed_report_add(sb_embedding_report *report, const sbi_embed_place *place, int index);

/* What the arrays of an update are made of: places, and the mesh that they are in. */
typedef struct sbi_embed_parts {
    const sbi_embed_place *places; /* [count] */
    const int *order;              /* [count] points along Morton's curve */
    int count, with_normals;
    int node_count, element_count, width, faces, outer_count; /* outer_count: boundary faces, or more */
    const int *elements;                                      /* [element_count][width] */
    const int *outer;       /* [element_count][faces] row of weights of boundary faces, or -1 */
    const sb_real *weights; /* angles at their nodes (rad) */
    const sbi_embed_face *face;
    int local[6][SB_MAX_FACE_NODES]; /* nodes of each face of an element */
} sbi_embed_parts;
SBI_API void sbi_embed_fill_local(sb_element_type type, int local[6][SB_MAX_FACE_NODES]);
/* Fills the arrays of e, which are zeros before, in memory from e->allocator; the same for the same places and mesh. 0:
 * no memory. */
SBI_API int sbi_embed_make_arrays(sb_embedding *e, const sbi_embed_parts *parts);
SBI_API void sbi_embed_free_arrays(sb_embedding *e);

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
