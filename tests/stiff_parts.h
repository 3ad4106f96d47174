/* stiff_parts.h: the shapes of what is stiff in a beam whose modulus jumps, for tests and benchmarks. */
#ifndef STIFF_PARTS_H
#define STIFF_PARTS_H

#include "check.h"

/* Where a beam of 3 x 1 x 1 cubes of its height is `jump` times as stiff. */
typedef enum stiff_parts {
    EVEN,
    BLOCK,      /* within */
    TOUCHING,   /* a block that reaches the surface */
    SLABS,      /* every other of six along x */
    SHEET,      /* a seventh of the height: one element thick on seven */
    ROD,        /* along x, of the same thickness */
    INCLUSIONS, /* balls of 0.08 to 0.18 in twenty places, some of which meet */
    SPECKS,     /* three cubes of a hundred, on seven to the height */
    STIFF_PARTS
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
    int y_strip = x[1] > 3 / 7.0 && x[1] < 4 / 7.0, z_strip = x[2] > 3 / 7.0 && x[2] < 4 / 7.0;
    switch (parts) {
    case BLOCK: return x[0] > 0.9 && x[0] < 1.8 && x[1] > 0.3 && x[1] < 0.66 && x[2] > 0.3 && x[2] < 0.66;
    case TOUCHING: return x[0] > 0.9 && x[0] < 1.8 && x[1] > 0.5 && x[2] > 0.4;
    case SLABS: return (int)(2 * x[0]) % 2;
    case SHEET: return z_strip;
    case ROD: return y_strip && z_strip;
    case INCLUSIONS: return stiff_parts_ball(x);
    case SPECKS: return ((int)(7 * x[0]) * 49 + (int)(7 * x[1]) * 7 + (int)(7 * x[2])) * 7919 % 100 < 3;
    default: return 0;
    }
}

#endif /* STIFF_PARTS_H */
