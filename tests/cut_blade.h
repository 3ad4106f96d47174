/* cut_blade.h: a blade that cuts a block, frame by frame. */
#ifndef CUT_BLADE_H
#define CUT_BLADE_H

#include "cut_block.h"

/* A straight edge that moves across the block's plane (middle, normal). */
typedef struct blade {
    sb_vec3 middle, along, ahead; /* half the edge; half the way */
} blade;

enum { CORNERS = 3 };

static inline blade blade_make(sb_vec3 middle, sb_vec3 normal, double angle)
{
    sb_vec3 u = sb_v3_perpendicular(normal), v = sb_v3_cross(normal, u);
    sb_real c = REAL(0.07 * cos(angle)), s = REAL(0.07 * sin(angle)), nu = sb_v3_norm(u), nv = sb_v3_norm(v);
    blade b;
    b.middle = middle;
    b.along = sb_v3_add(sb_v3_scale(c / nu, u), sb_v3_scale(s / nv, v));
    b.ahead = sb_v3_sub(sb_v3_scale(c / nv, v), sb_v3_scale(s / nu, u));
    return b;
}

/* Where it is at s in [-1, 1]. */
static inline void blade_at(const blade *b, double s, sb_vec3 edge[CORNERS])
{
    for (int k = 0; k < CORNERS; k++)
        edge[k] = sb_v3_madd(sb_v3_madd(b->middle, REAL(s), b->ahead), REAL(k - 1), b->along);
}

static inline int begin(block *b, const blade *of)
{
    sb_vec3 edge[CORNERS];
    sb_error error;
    int stroke = -1;
    blade_at(of, -1, edge);
    if (!CHECK_OK(sb_cut_begin(b->cut, edge, CORNERS, &stroke, &error)))
        printf("%s\n", error.message);
    return stroke;
}

static inline sb_cut_info move(block *b, const blade *of, int stroke, double s)
{
    sb_vec3 edge[CORNERS];
    sb_cut_info info;
    sb_error error;
    memset(&info, 0, sizeof info);
    blade_at(of, s, edge);
    if (!CHECK_OK(sb_cut_move(b->cut, stroke, edge, &info, &error)))
        printf("%s\n", error.message);
    return info;
}

/* Moves the blade from s to the end in so many frames, with a step after each. */
static inline void sweep(block *b, const blade *of, int stroke, double from, double to, int frames)
{
    for (int i = 1; i <= frames; i++) {
        move(b, of, stroke, from + (to - from) * i / frames);
        block_step(b, 1);
    }
}

static inline blade blade_random(unsigned long long *seed)
{
    sb_vec3 middle = sb_v3_add(sb_v3_scale(REAL(0.5), block_size), vector_in(-0.006, 0.006, seed));
    sb_vec3 normal = sb_v3_add(sb_v3(1, 0, 0), vector_in(-0.4, 0.4, seed));
    return blade_make(middle, normal, check_random_in(seed, 0, 6.28));
}

static inline uint64_t run_frames(block *b, const blade *of, int stroke, int first, int end)
{
    for (int i = first; i < end; i++) {
        move(b, of, stroke, -1 + 2 * (i + 1) / 16.0);
        block_step(b, 1);
    }
    return sb_body_state_hash(b->body);
}

static inline void *state_of(const block *b, size_t *size)
{
    void *state;
    *size = sb_body_state_size(b->body);
    state = malloc(*size);
    CHECK_OK(sb_body_state_save(b->body, state, *size));
    return state;
}

static inline void load(block *b, const void *state, size_t size)
{
    sb_error error;
    if (!CHECK_OK(sb_body_state_load(b->body, state, size, &error)))
        printf("%s\n", error.message);
}

#endif /* CUT_BLADE_H */
