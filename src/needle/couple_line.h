/* couple_line: what the coupled solve keeps of a rod, its line of nodes. Floor 6, internal: couple_line.c is the rod's
 * part of the linear system, couple.c finds the friction states.
 *
 * Rod nodes first .. first + count - 1 sit on the body's nodes path[0 .. count - 1]. The unknowns are displacements
 * over the step: of the body's nodes, u; the slip alpha of a coupled node along its tangent t; and the motion z of a
 * free one. Rod node i moves by
 *
 *     u + t alpha   coupled        z   free        target - x   held
 *
 * so that normal forces and static friction need no multipliers: they are the balance of the rod's rows. Where forces
 * balance before the end of the step (generalised alpha), unknowns are those of that level; the whole way is 1/level of
 * it, and the force there the same share between that of the last step and that at the end. The rod is
 * stepped by implicit Euler: its own vibrations are far above what steps resolve, and Euler leaves none of them. With
 * constraints on displacements that is passive next to a body stepped by Newmark (the rod's inertia, damping and
 * stiffness seen through the body's velocity have no negative real part on the unit circle). */
#ifndef NDL_COUPLE_LINE_H
#define NDL_COUPLE_LINE_H

#include "../softbody/solve/guest.h"
#include "couple.h"
#include "rod_private.h"

/* Unknowns of a rod node: the first three are z (in the block solve also u), the fourth is alpha. A bend joins the
 * first of node i - 2 to the last of node i. */
enum { NDLI_LINE_UNKNOWNS = 4, NDLI_LINE_WIDTH = 11 };

typedef struct ndli_line {
    ndl_rod *rod; /* borrowed */
    int capacity; /* rod nodes there is room for */
    sb_allocator allocator;
    void *memory;

    /* set by the room above before a solve */
    int first, count; /* rod node of path[0], and how many there are; node_count and 0: the rod is not in tissue. A node
                       * may follow: a tip that is hardly in has none of its own in the tissue */
    const int *path;  /* [count] nodes of the body; of a rod that is held by rows nothing */
    struct ndli_hold *holds; /* [capacity] of such a rod (couple_rows.h), from the node before `first` on: there its
                              * edge is held where it goes in. Its nodes have unknowns z throughout. NULL of others */
    unsigned char *state;    /* [nodes] ndl_contact; as found after it */
    double *friction;        /* [nodes] N: limit of static friction, and dynamic friction */
    double *viscous;         /* [nodes] N s/m: friction per slip speed */
    double cutting;          /* N: what holds the tip back beside friction while it goes forward */

    /* what a solve finds */
    double *slip;      /* [nodes] m along the tangent, of the rod past the tissue */
    ndli_v3 *move;     /* [nodes] displacement of the rod's nodes (m) */
    ndli_v3 *contact;  /* [nodes] force of the tissue on the rod (N); before it, that of the last step */
    ndli_v3 *reaction; /* [nodes] force of the supports on the rod (N) */

    /* holds nothing between solves */
    double dt, level; /* level: share of the new forces in the body's equations */
    const sb_matrix *matrix;
    ndli_v3 *tangent; /* [nodes] */
    ndli_v3 *load;    /* [nodes] right-hand side (N) */
    ndli_v3 *before;  /* [nodes] contact of the last step (N) */
    ndli_v3 *motion;  /* [nodes] */
    ndli_v3 *force;   /* [nodes] H times motion (N) */
    double *band;     /* [4 nodes][NDLI_LINE_WIDTH + 1] */
    double *right;    /* [4 nodes] */
} ndli_line;

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* 0: no memory. */
NDLI_API int ndli_line_create(ndli_line *line, ndl_rod *rod, const sb_allocator *allocator);
NDLI_API void ndli_line_free(ndli_line *line); /* safe on zeros */

SB_INLINE int ndli_line_is_slipping(const ndli_line *line, int i) { return line->state[i] > NDL_STATIC; }
/* 1 towards the tip, -1 towards the base. */
SB_INLINE int ndli_line_sign(const ndli_line *line, int i) { return line->state[i] == NDL_DYNAMIC_FORWARD ? 1 : -1; }
/* The first and the last node that has a state: what holds the tip acts at the last. */
SB_INLINE int ndli_line_rearmost(const ndli_line *line)
{
    return line->first - (line->holds && line->count > 0 ? 1 : 0);
}
SB_INLINE int ndli_line_foremost(const ndli_line *line) { return line->first + line->count - 1; }
/* Largest friction against slip of that sign (N). */
SB_INLINE double ndli_line_limit(const ndli_line *line, int i, int sign)
{
    return line->friction[i] + (sign > 0 && i == ndli_line_foremost(line) ? line->cutting : 0);
}
/* Nodes of the body that move as the rod's do. */
SB_INLINE int ndli_line_taken_count(const ndli_line *line) { return line->holds ? 0 : line->count; }
SB_INLINE int ndli_line_unknown_count(const ndli_line *line) { return NDLI_LINE_UNKNOWNS * line->rod->node_count; }

/* The rod's part of the system at its present shape: H, tangents, loads. Returns -1, or the node at which the rod is
 * folded. */
NDLI_API int ndli_line_linearise(ndli_line *line, const sbi_guest_step *step);
/* unknown[4 nodes] = where a solve starts: the rod goes on as it goes, nothing slips. */
NDLI_API void ndli_line_start(const ndli_line *line, double *unknown);
/* The band of what the rod's unknowns and its coupled nodes have among themselves at the present friction states;
 * matrix: the body's. */
NDLI_API void ndli_line_fill(ndli_line *line, const sb_matrix *matrix);
/* Factors it. 0: not positive definite. */
NDLI_API int ndli_line_factor(ndli_line *line);
/* Before a step: the contact forces are those at its start. */
NDLI_API void ndli_line_keep_contact(ndli_line *line);

/* The parts of a guest's calls; unknown: [4 nodes], nodes: [count][3] of the body's nodes on the path. */
/* y = loads - G x (loads != 0), or G x. */
NDLI_API void ndli_line_apply(ndli_line *line, int loads, const double *unknown, const double *nodes,
                              double *out_unknown, double *out_nodes);
/* z = (G + A)^-1 r on its rows. */
NDLI_API void ndli_line_solve_block(ndli_line *line, const double *unknown, const double *nodes, double *out_unknown,
                                    double *out_nodes);
/* vectors[i] += factor v, of a stride of reals. */
SB_INLINE void ndli_line_add_to(double *vectors, int stride, int i, double factor, ndli_v3 v)
{
    double *out = vectors + (size_t)stride * (size_t)i;
    out[0] += factor * v.x, out[1] += factor * v.y, out[2] += factor * v.z;
}
/* Force (N) on node i along its tangent that is known beforehand: friction while it slips. */
SB_INLINE double ndli_line_drag(const ndli_line *line, int i)
{
    int sign = ndli_line_sign(line, i);
    return -sign * ndli_line_limit(line, i, sign);
}
/* Viscous friction per slip (N/m). */
SB_INLINE double ndli_line_viscosity(const ndli_line *line, int i) { return line->viscous[i] / line->dt; }
/* The band += factor k between the first three unknowns of rod nodes a >= b. */
NDLI_API void ndli_line_add_to_band(ndli_line *line, int a, int b, double factor, const ndli_m3 *k);
/* slip, move, contact and reaction from the unknowns. */
NDLI_API void ndli_line_read(ndli_line *line, const double *unknown, const double *nodes);
#endif

#endif /* NDL_COUPLE_LINE_H */
