/* field: the potential about a target that matching slides down: its distance, or Laplace's. Floor 6. */
#ifndef REG_FIELD_H
#define REG_FIELD_H

#include "../softbody/geometry/surface.h"
#include "api.h"

typedef enum reg_field_kind {
    REG_FIELD_DISTANCE = 0, /* phi: distance to the target (m); exact everywhere, nothing is computed beforehand */
    REG_FIELD_LAPLACE = 1   /* Lap phi = 0 in a box, phi = 0 on the target and the distance on the box: the field of a
                             * charged conductor. Inside a closed target it is 0 */
} reg_field_kind;

/* What a field is made from; start from reg_default_field_def(). The target is a surface or a cloud. */
typedef struct reg_field_def {
    reg_field_kind kind;    /* default REG_FIELD_DISTANCE */
    const sb_mesh *surface; /* triangles or quads, open or closed, or NULL. Read at creation only, as are all below */
    const sb_vec3 *points;  /* [point_count] a cloud (m), or NULL */
    const sb_vec3 *normals; /* [point_count] outward, of any length, 0: unknown; or NULL: none are known */
    int point_count;
    sb_vec3 low, high;      /* Laplace: the box (m); it is enlarged to leave a tenth of the target's size around the
                             * target. Equal corners (default): that */
    int cells;              /* Laplace: grid cells along the longest side of the box, in [8, 256]; default 64, which
                             * takes some 0.3 s */
    sb_allocator allocator; /* zeros: malloc */
    sb_jobs jobs;           /* threads for the creation; zeros: none */
    unsigned cookie;        /* set by reg_default_field_def */
} reg_field_def;
REG_API reg_field_def reg_default_field_def(void);

typedef struct reg_field reg_field;

/* SB_ERROR_ARGUMENT (no target or two, a field out of range), SB_ERROR_NOT_FINITE (error->node: the point, or the
 * normal), what sb_surface_create says of the surface, SB_ERROR_MEMORY; *field is then untouched. Everything is copied.
 * Queries allocate nothing and may come from any number of threads. Release with reg_field_destroy. */
REG_API sb_result reg_field_create(const reg_field_def *def, reg_field **field, sb_error *error);
REG_API void reg_field_destroy(reg_field *field); /* NULL is fine */

/* The place of the target closest to a point. */
typedef struct reg_field_hit {
    sb_vec3 point;    /* m */
    sb_vec3 normal;   /* of the target there, unit length; 0 where none is known */
    sb_real distance; /* m */
    int item;         /* triangle (of the surface cut into triangles), or point of the cloud */
    int on_border;    /* 1: on the rim of an open target, beyond which nothing was seen */
} reg_field_hit;
/* 1 and *hit; 0 for a point that is not finite or absurdly far away (*hit untouched). guess: the item of a query
 * nearby, or -1; it changes the time, not the answer. About 1 us with a good guess. */
REG_API int reg_field_closest(const reg_field *field, sb_vec3 point, int guess, reg_field_hit *hit);

/* The potential on a line through a point. */
typedef struct reg_field_sample {
    sb_real phi;    /* m */
    sb_real phi_n;  /* slope along the direction over the length `step` */
    sb_real phi_nn; /* derivative of phi_n along the direction (1/m); of either sign */
} reg_field_sample;
/* Samples the potential at point (m) along the unit vector direction:
 *     phi_n = [phi(s + h n/2) - phi(s - h n/2)] / h,  phi_nn = d phi_n / ds
 * with h = step (m, > 0), which rounds the potential's kink on the target off. phi_nn is the exact derivative of this
 * phi_n, from the slopes at its two ends, not a difference of its own: Newton's method then converges as it should.
 * Laplace's phi outside its box is that of the nearest point of the box. Returns 0 as above.
 * Source: Suwelack 2014, (7.3), (7.15). */
REG_API int reg_field_along(const reg_field *field, sb_vec3 point, sb_vec3 direction, sb_real step, int guess,
                            reg_field_sample *sample);
/* phi (m) at a point, and its gradient unless NULL: away from the closest point, or of the trilinear interpolation. On
 * the target itself, where the distance has none, it is 0. Returns 0 as above. */
REG_API int reg_field_at(const reg_field *field, sb_vec3 point, int guess, sb_real *phi, sb_vec3 *gradient);

/* Smallest box around the target (m). */
REG_API void reg_field_bounds(const reg_field *field, sb_vec3 *low, sb_vec3 *high);
/* Laplace: sweeps that its solution took; 0 for distances. */
REG_API int reg_field_sweeps(const reg_field *field);

#if defined(REG_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* 1 for a cloud, and for a surface with a rim: it may be a part of something. */
REGI_API int regi_field_is_open(const reg_field *field);
#endif

#endif /* REG_FIELD_H */
