/* chance: normal numbers, the same everywhere. Floor 6, internal. */
#ifndef REGI_CHANCE_H
#define REGI_CHANCE_H

#include "api.h"

/* State of a generator: {a seed but 0, 0, 0}. */
typedef struct regi_chance {
    uint64_t state;
    double spare;
    int has_spare;
} regi_chance;

/* The next number of mean 0 and deviation 1. */
REGI_API double regi_chance_normal(regi_chance *chance);

#endif /* REGI_CHANCE_H */
