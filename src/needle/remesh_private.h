/* remesh_private: what is inside a remesher. Floor 6, internal: remesh.c works on it, remesh_state.c keeps it. */
#ifndef NDL_REMESH_PRIVATE_H
#define NDL_REMESH_PRIVATE_H

#include "remesh.h"

enum { NDLI_FINALISTS = 6 }; /* candidates that are smoothed before they are compared */

/* A split that can be undone; its tets are pool[first ...], `size` per tet that was cut. */
typedef struct ndli_split {
    int node, size, simplex[4];
    int first, count;
} ndli_split;

typedef struct ndli_needle {
    int *nodes, count, node_capacity; /* entry first */
    ndli_split *stack;
    int depth, stack_capacity;
    int undone; /* splits that the change under way has taken back */
    int *pool, pool_count, pool_capacity;
} ndli_needle;

typedef struct ndli_patch_tet {
    int nodes[4];
    int slot; /* -1: stood before the top split, and would again without it */
    int skin; /* bit c: the face opposite node c lies on the surface */
    sb_real quality;
} ndli_patch_tet;

typedef struct ndli_patch {
    ndli_patch_tet *tets;
    int count;
} ndli_patch;

typedef struct ndli_qualities {
    sb_real *values, least;
    int count;
} ndli_qualities;

typedef struct ndli_candidate {
    int simplex[4], size; /* size 1: snap */
    int undo, drops_tip;  /* the top split is undone first; the old tip stays in the tissue, but not on the needle */
    int slid, slid_moves; /* node that may slide along, or -1 */
    sb_vec3 X, slid_X;
    ndli_qualities created, removed;
} ndli_candidate;

/* The patch and a ring about it after one candidate, on which smoothing is tried. Nodes are numbered by the table
 * that all candidates of an operation share; the node to be made comes after it. */
typedef struct ndli_draft {
    int *tets, tet_count; /* [4]; those of the core first */
    int core_count;
    sb_real *qualities;
    sb_vec3 *X;             /* [table_count + 1] */
    int *star_start, *star; /* tets of a node: star[star_start[i] .. star_start[i + 1]) */
    unsigned char *is_free;
    int *moved, moved_count; /* nodes not where the candidate had them */
} ndli_draft;

typedef struct ndli_node_move {
    int node;
    sb_vec3 X;
} ndli_node_move;

/* A split that is undone: its node, and the corners that it was between. */
typedef struct ndli_leaving {
    int node, size, simplex[4];
} ndli_leaving;

struct ndl_remesh {
    ndl_remesh_def def;
    ndli_topology topology, *mesh; /* mesh: that topology */
    sb_body *body;
    int listener;          /* its number at the body */
    int own;               /* 1: the change that the body makes is ours */
    int stale;             /* 1: the body has got another mesh, which is not read yet */
    int joined;            /* 1: it is a part of the body's state */
    ndl_remesh *staged;    /* what a saved state that passed its checks will make of this; else NULL */
    ndli_leaving *leaving; /* nodes that the change under way takes out */
    int leaving_count, leaving_capacity;
    ndli_needle *needles;
    int release_cursor;
    ndl_remesh_info info;

    int needle, conflict; /* of the call under way; element of another needle that stood in the way, or -1 */
    int capacity;         /* of the patch */
    ndli_patch here, undone;
    int core_count;             /* of here: the tets that candidates may change; after them those that smoothing may */
    int *table, table_count;    /* nodes of the patch */
    unsigned char *table_whole; /* 1: all its tets are in the patch */
    ndli_draft draft;
    int *moving, moving_count;                   /* [4] nodes of a candidate's tets about its sliding node */
    ndli_candidate final[NDLI_FINALISTS], trial; /* best first */
    int final_count;
    sb_real *rating, *best_rating; /* qualities of a draft, worst first */
    ndli_node_move *moves;         /* what the winner's draft smoothed */
    int move_count;
    sb_real outcome; /* least quality about the tip that the winner leaves; that of now: */
    sb_real before;
    sb_real enough;       /* an operation that leaves less than this, and than before, fails; usually 0 */
    ndli_qualities taken; /* what undoing the top split removes */
    sb_real *sorted[2];
    int *groups, *kept; /* tets of the split that is made, and of the one that is undone for it */
    void *scratch;
};

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
SB_INLINE int ndli_remesh_has(const int nodes[4], int node)
{
    return nodes[0] == node || nodes[1] == node || nodes[2] == node || nodes[3] == node;
}

SB_INLINE int ndli_remesh_holds(const int nodes[4], const int *simplex, int size)
{
    for (int i = 0; i < size; i++)
        if (!ndli_remesh_has(nodes, simplex[i]))
            return 0;
    return 1;
}

/* ---- remesh_state.c ---- */

/* Memory for a needle of so many nodes, splits and pool entries; what it has stays. 0: there is none. */
NDLI_API int ndli_remesh_make_room(ndl_remesh *r, ndli_needle *needle, const int counts[3]);
/* Frees what it knows of mesh and needles. Safe on NULL. */
NDLI_API void ndli_remesh_free_knowledge(ndl_remesh *r);

/* What the ints of a command begin with; then the needle, and what the call returned. */
typedef enum ndli_remesh_command {
    NDLI_COMMAND_PUNCTURE = 1,  /* and tet, face; along, X, slip */
    NDLI_COMMAND_PENETRATE = 2, /* X */
    NDLI_COMMAND_RETRACT = 3,   /* X */
    NDLI_COMMAND_WITHDRAW = 4,
    NDLI_COMMAND_MADE = 5, /* the remesher was created, or destroyed */
    NDLI_COMMAND_GONE = 6
} ndli_remesh_command;

typedef sb_result (*ndli_remesh_replay)(void *user, const int *ints, size_t int_count, const sb_real *reals,
                                        size_t real_count, sb_error *error);
/* The remesher joins the state and the recording of its body. */
NDLI_API sb_result ndli_remesh_join(ndl_remesh *r, ndli_remesh_replay replay, sb_error *error);
NDLI_API void ndli_remesh_leave(ndl_remesh *r);
/* Between these a call changes the body, which its recording then holds as one command of the remesher; ints NULL: it
 * is not told, as calls with numbers that are none are not: they change nothing. */
NDLI_API void ndli_remesh_hush(ndl_remesh *r);
NDLI_API void ndli_remesh_tell(ndl_remesh *r, const int *ints, size_t int_count, const sb_real *reals,
                               size_t real_count);
NDLI_API void ndli_remesh_tell_puncture(ndl_remesh *r, int needle, const ndl_surface_hit *hit, sb_real slip,
                                        sb_result result);
NDLI_API void ndli_remesh_tell_move(ndl_remesh *r, int needle, sb_vec3 X, int forward, sb_result result);
NDLI_API void ndli_remesh_tell_withdraw(ndl_remesh *r, int needle, sb_result result);
#endif

#endif /* NDL_REMESH_PRIVATE_H */
