/* couple: one linear system for tissue and rods that stick to it or slip through it. Floor 6, internal but for
 * ndl_contact. Chapters 7 and 8 of Chentanez 2010, in the null-space form. */
#ifndef NDL_COUPLE_H
#define NDL_COUPLE_H

#include "api.h"

/* How a node of a needle goes with the tissue. */
typedef enum ndl_contact {
    NDL_FREE = 0,            /* outside */
    NDL_STATIC = 1,          /* sticks: friction below its limit */
    NDL_DYNAMIC_FORWARD = 2, /* slips towards the tip (DYNAMIC+) */
    NDL_DYNAMIC_BACKWARD = 3 /* slips towards the base (DYNAMIC-) */
} ndl_contact;

/* How the friction states of a step were found. */
typedef struct ndl_couple_info {
    int trials;     /* linear systems with different friction states, >= 1; the most of a Newton iteration */
    int consistent; /* 1: every node that sticks is within its limit, every one that slips goes the way it was taken to;
                     * 0: the cap on trials was hit, and the last solution was taken */
    int iterations; /* of conjugate gradients, in all trials */
    int capped;     /* 1: their cap was hit */
    sb_real residual; /* sqrt(r.M^-1 r) relative to its start */
} ndl_couple_info;

#endif /* NDL_COUPLE_H */
