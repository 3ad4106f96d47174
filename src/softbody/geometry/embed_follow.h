/* embed_follow: an embedding that follows a mesh in slots. Internal, floor 2; body_embed.c joins it with a body.
 *
 * It keeps the mesh at rest, the cells around each node and the outer faces, and changes them as the body's mesh
 * changes. Every point keeps its place at rest (sb_embedding.rest), which is its material: the points of changed cells,
 * and those outside that a changed node's face or cell holds, are placed anew from it. Three meshes are searched one
 * after the other, until all have a place: the cells that the change made or reshaped, which take points inside them
 * only; those around these, two deep, with complete normals in the middle; and all. Points that stay have the same bits
 * as before.
 *
 * When the change has happened, the groups of these points and the faces around the nodes that changed are taken out of
 * the arrays that updates read and made anew: what it costs goes with the change, not with mesh and points. What
 * updates give depends on the places and the mesh alone. */
#ifndef SBI_EMBED_FOLLOW_H
#define SBI_EMBED_FOLLOW_H

#include "../mesh/mesh_change.h"
#include "embed_private.h"

/* A mesh in slots. */
typedef struct sbi_embed_slots {
    int node_end, cell_end;
    const sb_vec3 *nodes;                                        /* [node_end] at rest (m) */
    const int *cells;                                            /* [cell_end][nodes per element] */
    const unsigned char *used;                                   /* [cell_end] 0: a free slot */
    int (*find_cell)(void *user, int cell, const sb_real xi[3]); /* see sb_mesh_change; or NULL */
    void *find_user;
} sbi_embed_slots;

/* Whom it follows. */
typedef struct sbi_embed_owner {
    void *body;                                                     /* NULL: nobody any more */
    int id;                                                         /* of the listener */
    sb_result (*refresh)(sb_embedding *embedding, sb_error *error); /* loads the body's mesh */
    void (*leave)(sb_embedding *embedding);
} sbi_embed_owner;

/* Memory handed out from the front; giving it back does nothing. */
typedef struct sbi_embed_pool {
    unsigned char *base;
    size_t size, used;
    size_t wanted; /* more than size: what the call that failed would have needed */
} sbi_embed_pool;

/* A point placed anew; before and after a change, by turns. */
typedef struct sbi_embed_swap {
    int point, done;
    sbi_embed_place place;
    sb_embedded_point info;
} sbi_embed_swap;

typedef struct sbi_embed_follower {
    sbi_embed_owner owner;
    int stale; /* 1: the mesh is another, and the points have no places in it yet, or for want of memory */
    int width, faces, face_nodes, face_corners, local[6][SB_MAX_FACE_NODES];

    int node_end, cell_end, node_room, cell_room;
    sb_vec3 *nodes; /* [node_room] */
    int *cells;     /* [cell_room][width]; the first is -1 in a free slot */
    int *first,
        *next;  /* [node_room], [cell_room][width]: lists of a node's corners, cell * width + local node; -1 ends */
    int *outer; /* [cell_room][faces] row of weights of outer faces, or -1 */
    sb_real *weights; /* [row_room][face_nodes] */
    int *free_rows, free_count, row_fresh, row_room;

    unsigned char *node_marks, *cell_marks; /* zeros between calls */
    int *changed_nodes, changed_count;      /* [node_room] nodes of the cells that change */
    int *part_cells, part_count;            /* [2][cell_room] cells that are searched, ascending, and scratch */
    int *part_nodes, part_node_count;       /* [node_room] */
    int *number;                            /* [node_room] of a node in the mesh that is searched */
    int *near_faces, near_count, near_room; /* outer faces around nodes that changed, from reserve on */

    sbi_embed_place *places; /* [point_count] */
    int *rank;               /* [point_count] place in the embedding's order */
    int *sorted;             /* [2][point_count] points of a change, and scratch */
    sbi_embed_swap *swaps;
    int swap_count, swap_room;
    sb_embedding_report report; /* after the change */

    sbi_embed_pool scratch;

    const sb_mesh_change *change;                                /* between reserve and what ends it */
    int (*find_cell)(void *user, int cell, const sb_real xi[3]); /* of what is being followed; or NULL */
    void *find_user;
    sb_vec3 *old_nodes; /* [old_room] of the slots that made nodes take */
    int old_room, old_node_end, old_cell_end;

    struct sbi_embed_prepared *prepared; /* of a mesh that is loaded next, whose points are known; or NULL */
} sbi_embed_follower;

/* What takes the follower's place when a mesh is loaded whose points are known (embed_held.h). */
struct sbi_embed_prepared {
    sbi_embed_follower *follower;
    sb_embedded_point *points;
    sbi_embed_arrays arrays;
};
SBI_API void sbi_embed_drop_prepared(const sb_embedding *e, sbi_embed_follower *f);

/* Follows this mesh from now on; all points are placed in it. On failure nothing has changed, but where it has an
 * owner, whose mesh this is, it is stale. */
SBI_API sb_result sbi_embed_follower_load(sb_embedding *e, const sbi_embed_slots *mesh, sb_error *error);
/* Prepares a change of the mesh. On failure nothing has changed; after success one of the next two ends it. */
SBI_API sb_result sbi_embed_follower_reserve(sb_embedding *e, const sb_mesh_change *change, sb_error *error);
SBI_API void sbi_embed_follower_follow(sb_embedding *e);
SBI_API void sbi_embed_follower_give_up(sb_embedding *e);
/* The report and the arrays' input as they are made of all places, which what follows a change must equal. */
SBI_API void sbi_embed_fill_report(const sb_embedding *e, const sbi_embed_follower *f, sb_embedding_report *report);
SBI_API void sbi_embed_fill_parts(const sb_embedding *e, const sbi_embed_follower *f, sbi_embed_parts *parts);
/* Leaves its owner and frees it with the arrays. */
SBI_API void sbi_embed_follower_destroy(sb_embedding *e);

/* The cell of a corner; of tet4 without a division, which would take longer than the rest of loops around nodes. */
SB_INLINE int sbi_embed_cell_of(const sbi_embed_follower *f, int corner)
{
    return f->width == 4 ? (int)((unsigned)corner >> 2) : corner / f->width;
}

/* 1: its points have no places in the mesh yet, and there is still no memory for it. */
SB_INLINE int sbi_embed_is_stale(sb_embedding *e)
{
    return e->follower && e->follower->stale && e->follower->owner.refresh(e, NULL) != SB_OK;
}

#endif /* SBI_EMBED_FOLLOW_H */
