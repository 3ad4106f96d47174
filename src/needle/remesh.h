/* remesh: keeps a node of the tissue at the tip of every needle, and a path of edges along what is inserted. Floor 6.
 * Chapter 9 of Chentanez 2010: node snaps and edge, face and tet splits round the tip, the best of them by the quality
 * of the mesh they leave, and a stack of undone splits, so that the tissue is the original one after the needle. */
#ifndef NDL_REMESH_H
#define NDL_REMESH_H

#include "../softbody/body/live_mesh.h"
#include "topology.h"

/* What a needle may do to the faces between regions. They follow the tip by parts of a tet either way, or no node could
 * pass them: the volume of each region is not kept, nor, where densities differ, the mass of the body; all of it is
 * undone at the end. */
typedef enum ndl_interface_rule {
    NDL_INTERFACE_KEEP_NODES = 0, /* their edges and faces are split, their nodes stay where they are: a tip just
                                   * behind one has flat tets about it, as just below the skin */
    NDL_INTERFACE_MOVE = 1        /* their nodes are snapped like any others: better tets, coarser regions */
} ndl_interface_rule;

/* How to remesh. Start from ndl_default_remesh_def(). */
typedef struct ndl_remesh_def {
    sb_body *body;                 /* of tet4, borrowed; outlives the remesher. Its mesh changes from then on */
    int max_needles;               /* >= 1; needles are numbered from 0. Default 4 */
    ndl_interface_rule interfaces; /* default NDL_INTERFACE_MOVE */
    sb_real smooth_below;   /* free nodes about the tip are moved while a tet there is worse than this; in [0, 1).
                             * Default 0.55; 0: never, as in the thesis */
    sb_real release_above;  /* nodes go back towards their own place, and splits that no needle needs are undone,
                             * where that leaves tets at least this good, or no worse; in [0, 1]. Default 0.6 */
    int max_smoothed;       /* nodes moved per operation at most, >= 0. Default 16 */
    sb_real entry_slip;     /* a puncture that leaves tets worse than half of smooth_below, when what lies below has
                             * made way, may go to a node or edge of the skin not further away than this share of the
                             * face's longest edge: where the skin is not flat, no node of it can be moved to the
                             * needle; in [0, 1]. Default 0.25 */
    sb_allocator allocator; /* default malloc */
    unsigned cookie;        /* set by ndl_default_remesh_def */
} ndl_remesh_def;

NDL_API ndl_remesh_def ndl_default_remesh_def(void);

typedef struct ndl_remesh ndl_remesh;

typedef enum ndl_operation {
    NDL_NO_OPERATION = 0,
    NDL_NODE_SNAP = 1, /* a node was moved to the tip */
    NDL_EDGE_SPLIT = 2,
    NDL_FACE_SPLIT = 3,
    NDL_TET_SPLIT = 4
} ndl_operation;

/* What a call did. */
typedef struct ndl_remesh_info {
    ndl_operation operation; /* the last one */
    int undone;              /* 1: the split that made the old tip was taken back before it */
    int substeps;            /* operations done */
    int candidates;          /* operations compared */
    int smoothed, released;  /* nodes moved for quality, and back towards their own place */
    int outside;             /* 1: the point lies outside the tissue. Penetrating: nothing was done. Retracting: the
                              * needle has left the tissue */
    sb_real worst_quality;   /* of the tets about the tip and the node next to it; 1 when the needle is out */
    sb_vec3 X;               /* where the tip is in the material (m) */
} ndl_remesh_info;

/* SB_ERROR_ARGUMENT (field named; the body has a remesher already), _UNSUPPORTED (elements other than SB_TET4;
 * def.slack was 0), _MEMORY leave *remesh untouched. While it has changed the mesh, changes by others are refused
 * (SB_ERROR_STATE).
 *
 * From now on the remesher is part of the body's saved state, its hash and its recording: sb_body_state_load asks for a
 * body with a remesher of the same def, and brings needles, splits and what is needed to undo them back to the last
 * bit. A recording of the body holds the calls below; it is played on a body with such a remesher. Make remeshers
 * before a recording is started, and destroy them after it has been stopped: what follows otherwise is refused when it
 * is played. */
NDL_API sb_result ndl_remesh_create(const ndl_remesh_def *def, ndl_remesh **remesh, sb_error *error);
/* Leaves the body as it is. Safe on NULL. */
NDL_API void ndl_remesh_destroy(ndl_remesh *remesh);

/* Takes the memory that a needle of up to so many nodes in the tissue usually needs, so that calls ask for none while
 * the mesh keeps to its slack. SB_ERROR_INDEX, _ARGUMENT (nodes < 0) and _MEMORY change nothing that can be seen. */
NDL_API sb_result ndl_remesh_reserve(ndl_remesh *remesh, int needle, int nodes, sb_error *error);

/* In all calls `needle` is in [0, max_needles) (SB_ERROR_INDEX) and `info` and `error` may be NULL. Each operation
 * happens as a whole or, when the call fails at it, not at all: SB_ERROR_MEMORY; SB_ERROR_NOT_FINITE;
 * SB_ERROR_ARGUMENT, a needle that is (not) in the tissue; SB_ERROR_MESH, no operation leaves sound tets: the step is
 * too long; SB_ERROR_UNSUPPORTED, every operation would change an element of another needle; and what the body or those
 * that follow its mesh refuse (see sb_body_change_commit). */

/* First contact: puts a node where the skin was hit, which is the needle's entry from then on, and its tip until it
 * goes deeper. The skin keeps its shape: nodes of it move within flat parts only, edges are split where the point lies
 * on them or their faces are in one plane; but see entry_slip. info->X: where the entry is. */
NDL_API sb_result ndl_remesh_puncture(ndl_remesh *remesh, int needle, const ndl_surface_hit *hit, ndl_remesh_info *info,
                                      sb_error *error);
/* The tip cuts on (retracts) to X_new (m, in the material), by as many operations as ndl_remesh_limit asks for, in a
 * straight line. After a failure it stays where the last operation brought it. A point outside: see
 * ndl_remesh_info.outside. */
NDL_API sb_result ndl_remesh_penetrate(ndl_remesh *remesh, int needle, sb_vec3 X_new, ndl_remesh_info *info,
                                       sb_error *error);
NDL_API sb_result ndl_remesh_retract(ndl_remesh *remesh, int needle, sb_vec3 X_new, ndl_remesh_info *info,
                                     sb_error *error);
/* The needle leaves: its nodes are released and its splits undone. When no other needle is in, the mesh is the
 * original one, number by number and place by place; else what a near needle prevents follows later. Where the body
 * refuses (SB_ERROR_MEMORY) it stays in. Does nothing for a needle that is not in. */
NDL_API sb_result ndl_remesh_withdraw(ndl_remesh *remesh, int needle, ndl_remesh_info *info, sb_error *error);

/* Nodes of the needle in the tissue, entry first, tip last; consecutive ones are joined by an edge. NULL and 0 when it
 * is not in. Valid until the next call. */
NDL_API const int *ndl_remesh_nodes(const ndl_remesh *remesh, int needle, int *count);
/* How far one operation may take the tip (m): half the shortest edge at the tip, but for the needle's own. */
NDL_API sb_real ndl_remesh_limit(const ndl_remesh *remesh, int needle);
/* Material position of a point in space, looked for from the tip; 0 when it is outside (*X is then the continuation of
 * the nearest tet's map), else 1. */
NDL_API int ndl_remesh_material_point(const ndl_remesh *remesh, int needle, sb_vec3 x, sb_vec3 *X);
/* First face of the body's surface that the segment crosses from outside in space (m); 0 and *hit untouched when there
 * is none. O(tets): for a needle that is not in yet. */
NDL_API int ndl_remesh_hit(const ndl_remesh *remesh, sb_vec3 from, sb_vec3 to, ndl_surface_hit *hit);
/* Splits not undone yet. */
NDL_API int ndl_remesh_split_count(const ndl_remesh *remesh, int needle);
/* How good the mesh is in the material; any place may be NULL. Quality: 6 sqrt(2) V / l_rms^3, 1 for the regular tet;
 * angles in degrees. O(tets). */
NDL_API void ndl_remesh_quality(const ndl_remesh *remesh, sb_real *worst_quality, sb_real *min_dihedral,
                                sb_real *max_dihedral);
/* 1 when the mesh is the one that the remesher was made on, number by number and place by place. */
NDL_API int ndl_remesh_is_original(const ndl_remesh *remesh);
/* Whether what the remesher knows of the mesh is consistent and the body's: for tests. SB_ERROR_MESH names the first
 * fault. */
NDL_API sb_result ndl_remesh_check(const ndl_remesh *remesh, sb_error *error);

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
#define NDLI_ENTRY_SLIP ((sb_real)0.25) /* the defaults of entry_slip */
/* What the remesher knows of the mesh; it stays where it is. */
NDLI_API const ndli_topology *ndli_remesh_topology(const ndl_remesh *remesh);
/* To be called before positions are read through it, once the body has moved; supports that are new are seen, too.
 * Where the body has got another mesh that is read, and no needle is in it: SB_ERROR_MEMORY. */
NDLI_API sb_result ndli_remesh_look(ndl_remesh *remesh, sb_error *error);
/* 1: the body has got another mesh since. */
NDLI_API int ndli_remesh_is_stale(const ndl_remesh *remesh);
/* 1: what changes the body's mesh until it is 0 again is the remesher's own. */
NDLI_API void ndli_remesh_set_own(ndl_remesh *remesh, int own);
/* Withdraws the needle, and where the body refuses that leaves its splits in the mesh. */
NDLI_API void ndli_remesh_let_go(ndl_remesh *remesh, int needle);
/* ndl_remesh_puncture with another entry_slip than the remesher's. */
NDLI_API sb_result ndli_remesh_puncture_within(ndl_remesh *remesh, int needle, const ndl_surface_hit *hit, sb_real slip,
                                               ndl_remesh_info *info, sb_error *error);
/* Takes a tip that is at its entry to X in one operation, however far that is. SB_ERROR_MESH, with nothing changed,
 * also when tets about it would be worse than `enough` and than they are. */
NDLI_API sb_result ndli_remesh_put_first(ndl_remesh *remesh, int needle, sb_vec3 X, sb_real enough,
                                         ndl_remesh_info *info);

/* ---- remesh_state.c ----
 * Undo: into memory of at least the snapshot's size, and back into the remesher it is from, once the body is back. */
NDLI_API size_t ndli_remesh_snapshot_size(const ndl_remesh *remesh);
NDLI_API size_t
ndli_remesh_snapshot_room(const ndl_remesh *remesh); /* most, while the needles keep to what was reserved */
NDLI_API void ndli_remesh_snapshot(const ndl_remesh *remesh, void *buffer);
NDLI_API void ndli_remesh_rewind(ndl_remesh *remesh, const void *buffer);
/* Between the check of a saved state and its load or refusal: the nodes that the needle has in it, as of
 * ndl_remesh_nodes. */
NDLI_API const int *ndli_remesh_staged_nodes(const ndl_remesh *remesh, int needle, int *count);
#endif

#endif /* NDL_REMESH_H */
