/* crossing: whether a triangle of a blade crosses a link, exactly. Internal. Floor 4, calls base only.
 *
 * Signs worked out in floating point hang bodies by threads. Here places are integers of 29 bits, determinants are
 * worked out exactly where rounding leaves their signs open, and ties are decided as if the whole blade were moved by
 * (e, e^2, e^3) for an e > 0 however small: with n = (b - a) x (c - a) of a triangle and lex(v) the sign of the first
 * component of v that is not 0
 *
 *     side of p                    sign n.(p - a),                  if 0: -lex(n)
 *     link p + s e passes ab on    sign e.((a - p) x (b - p)),      if 0: lex((b - a) x e)
 *
 * and the link from p to r is crossed when p and r lie on different sides and all three edges are passed on the same
 * one. So a link that meets an edge or a corner of a blade crosses exactly one of the triangles there or misses all,
 * and each node that a plane goes through falls to the same side for all links. */
#ifndef SB_CROSSING_H
#define SB_CROSSING_H

#include "../base/dense.h"

enum {
    SBI_CROSSING_TISSUE = 1 << 26, /* places in the box of the tissue are at most this far from its centre, per axis */
    SBI_CROSSING_BLADE = 1 << 28,  /* corners of blades: what lies farther is cut off */
    SBI_CROSSING_PARTS = 7         /* triangles that one of a blade can leave within that */
};

typedef struct sbi_int3 {
    int x, y, z;
} sbi_int3;

/* From space (m) to integers: x is at scale (x - centre), rounded; scale is a power of two. */
typedef struct sbi_crossing_frame {
    double centre[3], scale;
} sbi_crossing_frame;

/* A triangle of a blade, ready to be tested against. */
typedef struct sbi_blade {
    sbi_int3 corners[3];
    sbi_int3 low, high;
    int64_t normal[3];
    int tie; /* side of a point in the triangle's plane */
} sbi_blade;

/* A frame for tissue in the box [low, high] (m). */
SBI_API void sbi_crossing_frame_make(sb_vec3 low, sb_vec3 high, sbi_crossing_frame *frame);
/* Where a point of the tissue is, in the frame. */
SBI_API sbi_int3 sbi_crossing_round(const sbi_crossing_frame *frame, sb_vec3 x);
/* A triangle of a blade (m, finite) in the frame: what lies within reach of it, in at most SBI_CROSSING_PARTS triangles
 * that have an area; returns how many. Triangles that share an edge still share it. */
SBI_API int sbi_crossing_blades(const sbi_crossing_frame *frame, const sb_vec3 triangle[3],
                                sbi_blade blades[SBI_CROSSING_PARTS]);
/* Returns 0 when the triangle has no area. */
SBI_API int sbi_blade_make(const sbi_int3 corners[3], sbi_blade *blade);
/* n.(p - a), rounded, with its sign exact: > 0 above; 0: sbi_blade_side decides. */
SBI_API double sbi_blade_height(const sbi_blade *blade, sbi_int3 p);
SB_INLINE int sbi_blade_side(const sbi_blade *blade, double height)
{
    return height > 0 ? 1 : height < 0 ? -1 : blade->tie;
}
/* Whether the link from p to r, which differ in their sides, passes through the triangle. */
SBI_API int sbi_blade_is_passed(const sbi_blade *blade, sbi_int3 p, sbi_int3 r);
/* Whether the link from p to r is crossed; *t is where then, from 0 at p to 1 at r. */
SBI_API int sbi_blade_crosses(const sbi_blade *blade, sbi_int3 p, sbi_int3 r, sb_real *t);

#endif /* SB_CROSSING_H */
