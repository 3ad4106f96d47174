/* stiff_parts.h: the shapes of what is stiff in a beam whose modulus jumps, for tests and benchmarks. */
#ifndef STIFF_PARTS_H
#define STIFF_PARTS_H

#include "check.h"
#include "softbody.h"

/* What of a beam of 3 x 1 x 1 cubes of its height. */
typedef enum stiff_parts {
    STIFF_EVEN,
    STIFF_BLOCK,      /* within */
    STIFF_TOUCHING,   /* a block that reaches the surface */
    STIFF_SLABS,      /* every other of six along x */
    STIFF_SHEET,      /* a seventh of the height: one element thick on seven */
    STIFF_ROD,        /* along x, of the same thickness */
    STIFF_INCLUSIONS, /* balls of 0.08 to 0.18 in twenty places, some of which meet */
    STIFF_SPECKS,     /* three cubes of a hundred, on seven to the height */
    STIFF_COUNT
} stiff_parts;

static inline int stiff_parts_ball(const double x[3])
{
    unsigned long long seed = 5;
    for (int k = 0; k < 20; k++) {
        double place[3], radius, square = 0;
        for (int r = 0; r < 3; r++)
            place[r] = check_random_in(&seed, 0, r ? 1 : 3);
        radius = check_random_in(&seed, 0.08, 0.18);
        for (int r = 0; r < 3; r++)
            square += (x[r] - place[r]) * (x[r] - place[r]);
        if (square < radius * radius)
            return 1;
    }
    return 0;
}

/* Whether they hold the point x, in heights of the beam. */
static inline int stiff_parts_hold(stiff_parts parts, const double x[3])
{
    int y_strip = x[1] > 3 / 7.0 && x[1]<4 / 7.0, z_strip = x[2]> 3 / 7.0 && x[2] < 4 / 7.0;
    switch (parts) {
    case STIFF_BLOCK: return x[0] > 0.9 && x[0] < 1.8 && x[1] > 0.3 && x[1] < 0.66 && x[2] > 0.3 && x[2] < 0.66;
    case STIFF_TOUCHING: return x[0] > 0.9 && x[0] < 1.8 && x[1] > 0.5 && x[2] > 0.4;
    case STIFF_SLABS: return (int)(2 * x[0]) % 2;
    case STIFF_SHEET: return z_strip;
    case STIFF_ROD: return y_strip && z_strip;
    case STIFF_INCLUSIONS: return stiff_parts_ball(x);
    case STIFF_SPECKS: return ((int)(7 * x[0]) * 49 + (int)(7 * x[1]) * 7 + (int)(7 * x[2])) * 7919 % 100 < 3;
    default: return 0;
    }
}

/* Whether they hold the centre of a tet of a beam at the origin. */
static inline int stiff_parts_hold_tet(stiff_parts parts, const sb_vec3 *nodes, const int *tet, double height)
{
    double x[3] = {0, 0, 0};
    for (int k = 0; k < 4; k++) {
        x[0] += (double)nodes[tet[k]].x / (4 * height);
        x[1] += (double)nodes[tet[k]].y / (4 * height);
        x[2] += (double)nodes[tet[k]].z / (4 * height);
    }
    return stiff_parts_hold(parts, x);
}

#endif /* STIFF_PARTS_H */
