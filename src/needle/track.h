/* track: the way that a tip has cut, a polyline of material points. Floor 6, internal. */
#ifndef NDL_TRACK_H
#define NDL_TRACK_H

#include "real3.h"

typedef struct ndli_track {
    int count, capacity;
    double spacing; /* m: points are farther apart, but for the last */
    ndli_v3 *X;     /* [capacity] m at rest; borrowed, as what follows */
    double *arc;    /* [capacity] m from the skin, at rest */
    int *elements;  /* [capacity] where they are, to start a search from */
} ndli_track;

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
typedef struct ndli_track_point {
    ndli_v3 X, tangent; /* unit; 0 of a track of one point */
    int element;
} ndli_track_point;

SB_INLINE double ndli_track_length(const ndli_track *track) { return track->count ? track->arc[track->count - 1] : 0; }
NDLI_API void ndli_track_begin(ndli_track *track, ndli_v3 X, int element);
/* Goes on to X; 0: it has no room. */
NDLI_API int ndli_track_extend(ndli_track *track, ndli_v3 X, int element);
/* Ends it at arc, >= 0. */
NDLI_API void ndli_track_shorten(ndli_track *track, double arc);
/* Of a track of a point or more; beyond its ends: the end, with the tangent there. */
NDLI_API ndli_track_point ndli_track_at(const ndli_track *track, double arc);
#endif

#endif /* NDL_TRACK_H */
