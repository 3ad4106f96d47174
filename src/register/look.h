/* look: what is seen of an organ: points, their places of the model where it is now, and how far they are trusted.
 * Floor 6, internal. */
#ifndef REGI_LOOK_H
#define REGI_LOOK_H

#include "model_private.h"

/* A point of the target and its place of the model. */
typedef struct regi_look_point {
    sb_vec3 at, normal; /* m; unit, or 0 */
    sb_real weight;     /* trust given */
    sb_real sd;         /* m given, or 0 */
    int patch;
    /* of the last look */
    int triangle;         /* of the skin, or -1 */
    sb_real corner[3];    /* weights of its corners */
    sb_vec3 place, plane; /* m; unit normal of the model there */
    sb_real off;          /* gap less the median of its patch (m) */
    sb_real gap;          /* plane . (at - place) (m) */
    sb_real trust;        /* weight, less for outliers; 0: not allowed */
    sb_real share;        /* of its patch's row */
} regi_look_point;

/* Points of patches: point i of patch s has patch_start[s] <= i < patch_start[s + 1]. */
typedef struct regi_look {
    const sb_surface *tree; /* of the model's skin where it is */
    sb_real size;           /* m, of the organ */
    int has_camera;         /* 1: seen from `camera` (m) */
    sb_vec3 camera;
    regi_look_point *points; /* [point_count] by patch */
    int *patch_start;        /* [patch_count + 1] into points */
    sb_real *sort;           /* [the larger of both counts] scratch */
    sb_real noise;           /* m: of the points */
    int point_count, patch_count;
} regi_look;

/* A point with nothing known of its place; the normal may have any length. */
REGI_API void regi_look_take(regi_look_point *point, sb_vec3 at, sb_vec3 normal, sb_real weight, sb_real sd);
/* Finds a point's place. */
REGI_API void regi_look_place(const regi_look *look, regi_look_point *point);
/* Estimates the noise of the points, which have places, and trusts less what is far off: in all the target, by a limit
 * of at least `early` (m), and of so many medians of the gaps; and in its patch. */
REGI_API void regi_look_judge(regi_look *look, sb_real early, sb_real medians);
/* Shares of a patch's points in its row. Returns the variance (m^2) of their mean. */
REGI_API double regi_look_share_patch(regi_look *look, int patch);
/* Share of its given weight that a patch keeps. */
REGI_API sb_real regi_look_patch_trust(const regi_look *look, int patch);
/* The least trust with which a patch counts. */
REGI_API sb_real regi_look_least_trust(regi_look *look);
/* What share of the given weight is believed, and the mean and 95th percentile of the gaps (m) of what is. */
REGI_API void regi_look_measure(regi_look *look, sb_real *used, sb_real *residual, sb_real *residual_p95);

#endif /* REGI_LOOK_H */
