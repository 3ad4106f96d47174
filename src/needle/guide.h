/* guide: a straight needle's path to a target past tissue that it must not hit, found by chance and climbing, and what
 * to push, where and in which order, so that the path is free and meets the target. Floor 6.
 *
 *     ndl_guide_def def = ndl_default_guide_def(target, entry, direction);
 *     def.obstacles = nerves, def.obstacle_count = 2, def.clearance = 0.002;
 *     def.places = places, def.place_count = 6, def.max_force ... of each place
 *     def.model = compliance_of_my_tissue;
 *     ndl_guide_make(&def, &guide, &error);
 *     for (int k = 0; k < guide.phase_count; k++) {          (of phases that have a place)
 *         ndl_push_begin(&guide.phases[k].push, push + k, &error);
 *         (ndl_push_update of it and of those before it, with where their phases' points are now, until
 * push[k].arrived)
 *     }
 *     (insert along guide.direction from guide.entry, all pushes going on)
 *
 * A plan is for tissue that no needle moves. In a body a needle takes the target with it, tissue bends it: carry the
 * plan out in a simulation, put def.target off by where the target's material then is less the tip, make it again, and
 * so on until the tip meets it. In tests/test_guide_body.c targets are missed by 0.6 to 1.8 mm at first, by 0.02 to
 * 0.24 mm after the second plan and by at most 1 um after the fourth.
 *
 * Sources: Chentanez 2010, 12.2.2; Torabi et al. 2009: points of interest are where sensitive tissue enters a cylinder
 * about the path, one for each place where it is deepest; the deepest is moved out of the way first, the target onto
 * the path last; of many paths the one that asks for the least force is taken. */
#ifndef NDL_GUIDE_H
#define NDL_GUIDE_H

#include "steer.h"

enum { NDL_GUIDE_PHASES = 8, NDL_GUIDE_PLACES = 32 };

/* Where tissue may be pushed, and with what. Several may be at one point: a finger and a grip. */
typedef struct ndl_push_place {
    sb_vec3 direction; /* in which it pushes, any length; 0: any direction (a grip) */
    sb_real cone;      /* rad, in [0, pi/2]: how far the force may lean from it */
    sb_real max_force; /* N, > 0 */
    sb_real weight;    /* > 0: what a newton costs here, beside other places */
} ndl_push_place;

/* The tissue: how the material point (m, at rest) is displaced by a force at a place, m/N, as far as is known: from a
 * static solve with three forces, or a table of those. 0: unknown; then the place is not used for that point. Finite.
 */
typedef int (*ndl_push_model)(void *user, sb_vec3 point, int place, sb_mat3 *compliance);

/* Start from ndl_default_guide_def. */
typedef struct ndl_guide_def {
    sb_vec3 target;           /* m, at rest */
    sb_vec3 entry, direction; /* m, and any length but 0: the middle of a disc across `direction` through which */
    sb_real entry_radius;     /* paths go, of this radius (m), >= 0; default 1/10 of its distance to the target. What
                               * lies before the disc is not looked at */
    sb_real max_lean;         /* rad, in [0, 1.5]: of paths from `direction`; default 0.6 */
    sb_real shift;            /* m, >= 0: how far from the target at rest paths may pass; default as entry_radius */
    const ndl_obstacle *obstacles; /* [obstacle_count] tissue to keep out of, borrowed; it moves; default none */
    int obstacle_count;
    sb_real clearance;            /* m from obstacles, > 0: half the needle's diameter, and margin; default 1/50 of the
                                   * distance */
    const ndl_push_place *places; /* [place_count], at most NDL_GUIDE_PLACES, borrowed; default none */
    int place_count;
    ndl_push_model model; /* needed with places */
    void *user;
    sb_real tolerance; /* m, > 0: within it the target is met and clearance kept; default 1/200 of the distance */
    int samples;       /* paths tried by chance, 1 to a million; default 200 */
    int climbs;        /* tries to better the best one by ever smaller changes, 0 to a million; default 100 */
    unsigned seed;     /* of chance */
    unsigned cookie;   /* set by ndl_default_guide_def */
} ndl_guide_def;

/* One push. */
typedef struct ndl_guide_phase {
    ndl_push_def push; /* for ndl_push_begin; its direction is the place's */
    sb_vec3 point;     /* m, at rest: the point of interest, which the push is to be told of where it is */
    int obstacle;      /* that is moved out of the way; -1: the target is moved onto the path */
    int place;         /* -1: nothing has to be done, or no place can do anything; `push` is then not to be begun */
    sb_vec3 force;     /* N that the model expects */
    sb_real depth;     /* m that the point has to go at rest */
    sb_real left;      /* m that all forces of the plan leave of it */
} ndl_guide_phase;

typedef struct ndl_guide {
    int reaches;              /* 1: the target is met, obstacles are cleared, to the tolerance, by the model */
    sb_vec3 entry, direction; /* m, unit: the needle's straight path, */
    sb_real length;           /* m, to where the target then is */
    sb_real clearance;        /* m: of obstacles to the path, all forces being there; SB_REAL_MAX without obstacles */
    sb_real cost;             /* N, sum of weight times force */
    int phase_count;          /* >= 1, the target's is last */
    ndl_guide_phase phases[NDL_GUIDE_PHASES];
} ndl_guide;

NDL_API ndl_guide_def ndl_default_guide_def(sb_vec3 target, sb_vec3 entry, sb_vec3 direction);

/* The path, among `samples` random ones (the straight one to the target first) and `climbs` changes of the best, whose
 * pushes cost least; paths that leave obstacles in the way or the target aside cost more than any that do not.
 * Displacements add up (linear tissue); a place pushes in one phase only. Points of interest beyond NDL_GUIDE_PHASES -
 * 1 are not pushed, but count. SB_OK with any outcome. Failures leave *guide untouched: SB_ERROR_ARGUMENT (field,
 * obstacle or place named), SB_ERROR_NOT_FINITE (also of the model). Some 0.1 ms for a path and phase with 8 places,
 * beside what the model takes, which is asked some 128 times for each of up to four tries of a path and each place in
 * use. Distances are looked at in 64 points of a path: an obstacle thinner than 1/64 of it may lie between two, and
 * `clearance` is too large by up to 1/32 of the path over 8 clearances. A distance that is no number is within an
 * obstacle. Deterministic to the bit, nothing is allocated. */
NDL_API sb_result ndl_guide_make(const ndl_guide_def *def, ndl_guide *guide, sb_error *error);

#endif /* NDL_GUIDE_H */
