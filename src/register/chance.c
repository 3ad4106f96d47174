/* chance: see chance.h. */
#include "chance.h"

#include <math.h>

#include "../softbody/base/dense.h"

/* In (-1, 1): xorshift64*. */
static double regi_chance_uniform(regi_chance *chance)
{
    chance->state ^= chance->state >> 12;
    chance->state ^= chance->state << 25;
    chance->state ^= chance->state >> 27;
    return (double)((chance->state * 2685821657736338717u) >> 11) / 4503599627370496.0 - 1;
}

/* By Marsaglia's polar method. */
REGI_API double regi_chance_normal(regi_chance *chance)
{
    double u, v, square;
    if (chance->has_spare) {
        chance->has_spare = 0;
        return chance->spare;
    }
    do {
        u = regi_chance_uniform(chance);
        v = regi_chance_uniform(chance);
        square = u * u + v * v;
    } while (!(square > 0) || square >= 1);
    square = sqrt(-2 * sbi_dense_log(square) / square);
    chance->spare = v * square;
    chance->has_spare = 1;
    return u * square;
}
