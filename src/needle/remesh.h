/* remesh: keeps a node of the tissue at the tip of every needle, and a path of edges along what is inserted. Floor 6.
 * Chapter 9 of Chentanez 2010: node snaps and edge, face and tet splits round the tip, the best of them by the quality
 * of the mesh they leave, and a stack of undone splits, so that the tissue is the original one after the needle. */
#ifndef NDL_REMESH_H
#define NDL_REMESH_H

#include "api.h"
#include "tissue_mesh.h"

/* What a needle may do to the faces between regions. They follow the tip by parts of a tet either way, or no node could
 * pass them: the volume of each region is not kept, that of the tissue and its mass are; all of it is undone at the
 * end. */
typedef enum ndl_interface_rule {
    NDL_INTERFACE_KEEP_NODES = 0, /* their edges and faces are split, their nodes stay where they are: a tip just
                                   * behind one has flat tets about it, as just below the skin */
    NDL_INTERFACE_MOVE = 1        /* their nodes are snapped like any others: better tets, coarser regions */
} ndl_interface_rule;

/* How to remesh. Start from ndl_default_remesh_def(). */
typedef struct ndl_remesh_def {
    ndl_tissue_mesh *tissue;  /* borrowed; outlives the remesher */
    int max_needles;          /* >= 1; needles are numbered from 0. Default 4 */
    ndl_interface_rule interfaces; /* default NDL_INTERFACE_MOVE */
    sb_real smooth_below;     /* free nodes about the tip are moved while a tet there is worse than this; in [0, 1).
                               * Default 0.55; 0: never, as in the thesis */
    sb_real release_above;    /* nodes go back towards their own place, and splits that no needle needs are undone,
                               * where that leaves tets at least this good, or no worse; in [0, 1]. Default 0.6 */
    int max_smoothed;         /* nodes moved per operation at most, >= 0. Default 16 */
    sb_real entry_slip;       /* a puncture that leaves tets worse than half of smooth_below, when what lies below has
                               * made way, may go to a node or edge of the skin not further away than this share of the
                               * face's longest edge: where the skin is not flat, no node of it can be moved to the
                               * needle; in [0, 1]. Default 0.25 */
    sb_allocator allocator;   /* default malloc */
    unsigned cookie;          /* set by ndl_default_remesh_def */
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

/* SB_ERROR_ARGUMENT (field named), _MEMORY leave *remesh untouched. Uses of the tissue by several remeshers at a time
 * are not foreseen. */
NDL_API sb_result ndl_remesh_create(const ndl_remesh_def *def, ndl_remesh **remesh, sb_error *error);
/* Leaves the tissue as it is. Safe on NULL. */
NDL_API void ndl_remesh_destroy(ndl_remesh *remesh);

/* Takes the memory that a needle of up to so many nodes in the tissue usually needs, so that calls ask for none while the
 * mesh keeps to its slack. SB_ERROR_INDEX, _ARGUMENT (nodes < 0) and _MEMORY change nothing that can be seen. */
NDL_API sb_result ndl_remesh_reserve(ndl_remesh *remesh, int needle, int nodes, sb_error *error);

/* In all calls `needle` is in [0, max_needles) (SB_ERROR_INDEX) and `info` and `error` may be NULL. Each operation
 * happens as a whole or, when the call fails at it, not at all: SB_ERROR_MEMORY; SB_ERROR_NOT_FINITE;
 * SB_ERROR_ARGUMENT, a needle that is (not) in the tissue; SB_ERROR_MESH, no operation leaves sound tets: the step is
 * too long; SB_ERROR_UNSUPPORTED, every operation would change an element of another needle. Memory is only asked for
 * when slack is used up. */

/* First contact: puts a node where the skin was hit, which is the needle's entry from then on, and its tip until it goes
 * deeper. The skin keeps its shape: nodes of it move within flat parts only, edges are split where the point lies on them or
 * their faces are in one plane; but see entry_slip. info->X: where the entry is. */
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
 * original one, number by number and place by place; else what a near needle prevents follows later. No failure but
 * SB_ERROR_INDEX; does nothing for a needle that is not in. */
NDL_API sb_result ndl_remesh_withdraw(ndl_remesh *remesh, int needle, ndl_remesh_info *info, sb_error *error);

/* Nodes of the needle in the tissue, entry first, tip last; consecutive ones are joined by an edge. NULL and 0 when it
 * is not in. Valid until the next call. */
NDL_API const int *ndl_remesh_nodes(const ndl_remesh *remesh, int needle, int *count);
/* How far one operation may take the tip (m): half the shortest edge at the tip, but for the needle's own. */
NDL_API sb_real ndl_remesh_limit(const ndl_remesh *remesh, int needle);
/* Material position of a point in space, looked for from the tip; 0 when it is outside (*X is then the continuation of
 * the nearest tet's map), else 1. */
NDL_API int ndl_remesh_material_point(const ndl_remesh *remesh, int needle, sb_vec3 x, sb_vec3 *X);
/* Splits not undone yet. */
NDL_API int ndl_remesh_split_count(const ndl_remesh *remesh, int needle);

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
#define NDLI_ENTRY_SLIP ((sb_real)0.25) /* the defaults of entry_slip */
/* ndl_remesh_puncture with another entry_slip than the remesher's, and the way (material direction of any length) that
 * the needle will take from there; 0: straight into the skin. */
NDLI_API sb_result ndli_remesh_puncture_within(ndl_remesh *remesh, int needle, const ndl_surface_hit *hit, sb_real slip,
                                               sb_vec3 way, ndl_remesh_info *info, sb_error *error);
/* Places for the first node below the entry: from (exclusive) the entry to a point deeper in. A place is good where tets
 * about it are no worse than `good` or than they were, and good enough with `enough`; m, quality. */
typedef struct ndli_first_places {
    sb_vec3 from, to;
    sb_real good, enough;
} ndli_first_places;
/* Gives a tip that is at its entry a node in one operation, at the deepest good place; if none is, at the best of them.
 * SB_ERROR_MESH, with nothing changed, when that is not even good enough. */
NDLI_API sb_result ndli_remesh_put_first(ndl_remesh *remesh, int needle, const ndli_first_places *places,
                                         ndl_remesh_info *info);
#endif

#endif /* NDL_REMESH_H */
