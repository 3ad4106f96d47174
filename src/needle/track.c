/* track: see track.h. */
#include "track.h"

static void ndli_track_put(ndli_track *track, int k, ndli_v3 X, int element)
{
    track->X[k] = X;
    track->elements[k] = element;
    track->arc[k] = k ? track->arc[k - 1] + ndli_norm(ndli_sub(X, track->X[k - 1])) : 0;
    track->count = k + 1;
}

/* Pieces are longer than this (m). */
static double ndli_track_least(const ndli_track *track) { return 1e-9 * track->spacing; }

NDLI_API void ndli_track_begin(ndli_track *track, ndli_v3 X, int element) { ndli_track_put(track, 0, X, element); }

NDLI_API int ndli_track_extend(ndli_track *track, ndli_v3 X, int element)
{
    int last = track->count - 1;
    int moves = last > 0 && ndli_norm(ndli_sub(X, track->X[last - 1])) < track->spacing;
    if (!(ndli_norm(ndli_sub(X, track->X[moves ? last - 1 : last])) > ndli_track_least(track)))
        return 1;
    if (!moves && track->count == track->capacity)
        return 0;
    ndli_track_put(track, moves ? last : track->count, X, element);
    return 1;
}

/* The last point not beyond arc that has another behind it. */
static int ndli_track_piece(const ndli_track *track, double arc)
{
    int low = 0, high = track->count - 1;
    while (high - low > 1) {
        int middle = low + (high - low) / 2;
        if (track->arc[middle] <= arc)
            low = middle;
        else
            high = middle;
    }
    return low;
}

NDLI_API ndli_track_point ndli_track_at(const ndli_track *track, double arc)
{
    ndli_track_point point;
    int k = ndli_track_piece(track, arc);
    double length, share;
    point.X = track->X[k];
    point.element = track->elements[k];
    point.tangent = ndli_v(0, 0, 0);
    if (track->count < 2)
        return point;
    length = track->arc[k + 1] - track->arc[k];
    share = length > 0 ? (arc - track->arc[k]) / length : 0;
    share = share < 0 ? 0 : share > 1 ? 1 : share;
    point.tangent = ndli_sub(track->X[k + 1], track->X[k]);
    point.X = ndli_madd(point.X, share, point.tangent);
    if (length > 0)
        point.tangent = ndli_scale(1 / length, point.tangent);
    return point;
}

NDLI_API void ndli_track_shorten(ndli_track *track, double arc)
{
    ndli_track_point end = ndli_track_at(track, arc);
    int k = ndli_track_piece(track, arc);
    if (!(arc < ndli_track_length(track)))
        return;
    track->count = k + 1;
    if (arc - track->arc[k] > ndli_track_least(track))
        ndli_track_put(track, k + 1, end.X, end.element);
}
