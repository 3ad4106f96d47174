/* couple_rows: a rod that springs hold at rows of a body's nodes. Floor 6, internal.
 *
 * A hold is where a rod node, or the point of its next edge at the skin, is tied to a material point of the body, x =
 * sum_a w_a x_a. The rod's nodes keep unknowns of their own; with s the rod's way past the tissue (m) the force on the
 * rod is
 *
 *     across  -k (I - t t^T) s       along  -k' t.s while it sticks, its friction while it slips
 *
 * Both springs are what the mesh does not show of the tissue about a line: a load q (N/m) moves the mesh as if it were
 * spread over a circle of a radius that goes with the elements, the needle's is smaller, and tissue gives so much more
 * there (Kelvin's line load; Peaceman's 1978 well radius carried over). So forces have a limit as meshes get finer,
 * nothing is stiffer than tissue, and a needle goes into elements of any kind, several into one. Friction is Tresca's,
 * its states are found as in couple.c: with a spring in series a step is a convex problem as before. */
#ifndef NDL_COUPLE_ROWS_H
#define NDL_COUPLE_ROWS_H

#include "../softbody/mesh/element.h"
#include "couple_line.h"

/* What ties rod node i, by its number. */
struct ndli_hold {
    double share;                     /* of the way from rod node i to the next one where it is; 0: at the node */
    int count;                        /* 0: nothing holds it */
    int places[SB_MAX_ELEMENT_NODES]; /* of its nodes in the guest's list */
    double weights[SB_MAX_ELEMENT_NODES];
    double length;        /* m of shaft that counts with it */
    double across, along; /* k, k' (N/m) */
    ndli_v3 tangent;
    ndli_v3 offset; /* s at the start of the step (m) */
};

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* What ndli_line_apply leaves out, which goes before it: added to out_unknown [4 nodes] and out_nodes [guest's
 * nodes][3]; nodes likewise. */
NDLI_API void ndli_rows_apply(ndli_line *line, int loads, const double *nodes, double *out_unknown, double *out_nodes);
/* Adds what holds have between the rod's own unknowns to its band. */
NDLI_API void ndli_rows_add_band(ndli_line *line);
/* contact, slip and reactions; after ndli_line_read. */
NDLI_API void ndli_rows_read(ndli_line *line, const double *nodes);
#endif

#endif /* NDL_COUPLE_ROWS_H */
