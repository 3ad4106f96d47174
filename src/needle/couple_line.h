/* couple_line: what the coupled solve keeps of a rod, its line of nodes. Floor 6, internal: couple_line.c is the rod's
 * part of the linear system, couple.c finds the friction states.
 *
 * Rod nodes first .. first + count - 1 sit on the tissue's nodes path[0 .. count - 1]. The unknowns are accelerations of
 * the tissue, a, and in the same measure (displacements over kappa = beta dt^2) the slip alpha of a coupled node along
 * its tangent t and the motion of a free one, z. With `known` the part of a displacement that no unknown brings, rod node i moves by
 *
 *     u = known + kappa (a + t alpha)   coupled        u = known + kappa z   free        u = known   held
 *
 * so that normal forces and static friction need no multipliers: they are the balance of the rod's rows. The rod is
 * stepped by implicit Euler: its own vibrations are far above what steps resolve, and Euler leaves none of them. With
 * constraints on displacements that is passive next to a tissue stepped by Newmark (the rod's inertia, damping and
 * stiffness seen through the tissue's velocity have no negative real part on the unit circle). */
#ifndef NDL_COUPLE_LINE_H
#define NDL_COUPLE_LINE_H

#include "couple.h"
#include "rod_private.h"
#include "tissue_private.h"

/* Unknowns of a rod node in the band: a or z, and alpha. A bend joins the first of node i - 2 to the last of node i. */
enum { NDLI_LINE_UNKNOWNS = 4, NDLI_LINE_WIDTH = 11 };

typedef double ndli_line_unknown[NDLI_LINE_UNKNOWNS];

typedef struct ndli_line {
    ndl_rod *rod;    /* borrowed */
    ndl_tissue *tissue; /* borrowed */
    int capacity;    /* rod nodes there is room for */
    sb_allocator allocator;
    void *memory;

    /* set by the room above before a solve */
    int first, count; /* rod node of path[0], and how many there are; node_count and 0: the rod is not in tissue. A node
                       * may follow: a tip that is hardly in has none of its own in the tissue */
    const int *path; /* [count] tissue nodes */
    unsigned char *state; /* [nodes] ndl_contact; as found after it */
    double *friction; /* [nodes] N: limit of static friction, and dynamic friction */
    double *viscous;  /* [nodes] N s/m: friction per slip speed */
    double cutting;   /* N: what holds the tip back beside friction while it goes forward */

    /* what a solve finds */
    double *slip;        /* [nodes] m along the tangent, of the rod past the tissue */
    ndli_v3 *move;       /* [nodes] displacement of the rod's nodes (m) */
    ndli_v3 *contact;    /* [nodes] force of the tissue on the rod (N) */
    ndli_v3 *reaction;   /* [nodes] force of the supports on the rod (N) */

    /* holds nothing between solves */
    double dt, kappa;
    ndli_v3 *tangent;    /* [nodes] */
    ndli_v3 *known;      /* [nodes] (m) */
    ndli_v3 *load;       /* [nodes] right-hand side, known displacements in it (N) */
    ndli_v3 *motion;     /* [nodes] */
    ndli_v3 *force;      /* [nodes] kappa H times motion (N) */
    ndli_line_unknown *unknown, *residual, *search, *product, *correction; /* [nodes] */
    double *band, *right; /* [4 nodes][NDLI_LINE_WIDTH + 1], [4 nodes] */
} ndli_line;

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* 0: no memory. */
NDLI_API int ndli_line_create(ndli_line *line, ndl_rod *rod, ndl_tissue *tissue, const sb_allocator *allocator);
NDLI_API void ndli_line_free(ndli_line *line); /* safe on zeros */

SB_INLINE int ndli_line_is_slipping(const ndli_line *line, int i) { return line->state[i] > NDL_STATIC; }
/* 1 towards the tip, -1 towards the base. */
SB_INLINE int ndli_line_sign(const ndli_line *line, int i)
{
    return line->state[i] == NDL_DYNAMIC_FORWARD ? 1 : -1;
}
/* The last coupled node: what holds the tip acts there. */
SB_INLINE int ndli_line_foremost(const ndli_line *line) { return line->first + line->count - 1; }
/* Largest friction against slip of that sign (N). */
SB_INLINE double ndli_line_limit(const ndli_line *line, int i, int sign)
{
    return line->friction[i] + (sign > 0 && i == ndli_line_foremost(line) ? line->cutting : 0);
}

/* The rod's part of the system at its present shape, after ndli_solid_begin: kappa H, tangents, known displacements
 * and loads; unknowns 0. Returns -1, or the node at which the rod is folded. */
NDLI_API int ndli_line_linearise(ndli_line *line, double dt);
/* Rows of the present friction states: the band of what the rod's unknowns and its coupled tissue nodes have among
 * themselves, factored. 0: not positive definite. */
NDLI_API int ndli_line_factor(ndli_line *line);

/* The parts of a guest of the tissue's solve; see ndli_solid_guest. */
NDLI_API void ndli_line_begin(ndli_line *line);
NDLI_API void ndli_line_settle(ndli_line *line);
NDLI_API void ndli_line_direct(ndli_line *line, double factor);
NDLI_API double ndli_line_multiply(ndli_line *line);
NDLI_API void ndli_line_advance(ndli_line *line, double factor);
NDLI_API double ndli_line_precondition(ndli_line *line);

/* unknown = that of the rod's block alone, with tissue->unknown on coupled rows; after ndli_line_precondition. */
NDLI_API void ndli_line_guess(ndli_line *line);
/* slip, move, contact and reaction from the unknowns. */
NDLI_API void ndli_line_read(ndli_line *line);
#endif

#endif /* NDL_COUPLE_LINE_H */
