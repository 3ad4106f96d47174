/* mapping: points between nodes, as rows of weights. Floor 0. */
#ifndef SB_MAPPING_H
#define SB_MAPPING_H

#include "dense.h"

/* Rows of node weights: row j is the point sum_k weights[k] x(nodes[k]), row_start[j] <= k < row_start[j + 1], as the
 * barycentric coordinates of a landmark inside an element, or a mean over a patch. Weights of either sign; a row
 * whose weights do not sum to 1 is no point, but works too. */
typedef struct sb_mapping {
    int row_count;
    const int *row_start;   /* [row_count + 1] ascending from 0; no row is empty */
    const int *nodes;       /* [row_start[row_count]] */
    const sb_real *weights; /* [row_start[row_count]] */
} sb_mapping;

/* out[row_count] = H^T x: what the rows are of x[nodes]: their points of positions, their displacements of
 * displacements. Not checked: nodes must be within x. out and x do not overlap. */
SB_API void sb_mapping_apply(const sb_mapping *mapping, const sb_vec3 *x, sb_vec3 *out);
/* forces[nodes] += H f: forces f[row_count] at the rows' points, brought to their nodes. */
SB_API void sb_mapping_spread(const sb_mapping *mapping, const sb_vec3 *f, sb_vec3 *forces);

#endif /* SB_MAPPING_H */
