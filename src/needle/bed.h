/* bed: a body of any elements, cut or not, as a needle sees it that is held by rows of weights. Floor 6, internal.
 *
 * A place is a material point: an element of the mesh that the body had when its first needle was made, or, where it
 * had been cut and what knows its pieces is there, before that, and coordinates in it. Where a blade has cut that
 * element since, the place is in the piece that has its material. */
#ifndef NDL_BED_H
#define NDL_BED_H

#include "../softbody/body/body_guest.h"
#include "../softbody/geometry/embed_search.h"
#include "real3.h"

typedef struct ndli_place {
    int element; /* -1: none */
    sb_real xi[3];
} ndli_place;

/* What a place moves with. */
typedef struct ndli_bed_row {
    int cell, count;
    int nodes[SB_MAX_ELEMENT_NODES];
    double weights[SB_MAX_ELEMENT_NODES]; /* sum to 1 */
} ndli_bed_row;

typedef struct ndli_bed {
    sb_body *body;
    sb_allocator allocator;
    sb_mesh mesh; /* at rest */
    int *cells;   /* [elements] of the body */
    sbi_embed_volume volume;
    double mean_edge; /* m */
    int was_cut;      /* 1: when this was made */
    int version;      /* of the body's mesh, then */
    uint64_t hash;    /* of what it is made from: cells, their nodes and where these are */
    int is_lost;      /* 1: others than an sb_cut have changed the body's mesh since */
} ndli_bed;

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* From the mesh of `mesh_of`, which the body has, or will have; uncut 1: from that before any cut, which the body knows
 * (sbi_body_has_uncut). */
NDLI_API sb_result ndli_bed_create(sb_body *body, const sb_body *mesh_of, int uncut, const sb_allocator *allocator,
                                   ndli_bed *bed, sb_error *error);
/* It becomes `next`, which is zeros then. */
NDLI_API void ndli_bed_replace(ndli_bed *bed, ndli_bed *next);
NDLI_API void ndli_bed_free(ndli_bed *bed); /* safe on zeros */

/* Where X (m, at rest) is; `hint` is an element to start from. 0: outside, and *place is the nearest. */
NDLI_API int ndli_bed_locate(const ndli_bed *bed, sb_vec3 X, int hint, ndli_place *place);
/* 0: its material has been taken away. */
NDLI_API int ndli_bed_row_at(const ndli_bed *bed, const ndli_place *place, ndli_bed_row *row);
/* Both at once; *row has no nodes where there is no material: outside, by more than rounding, or taken away. */
NDLI_API int ndli_bed_find(const ndli_bed *bed, sb_vec3 X, int hint, ndli_place *place, ndli_bed_row *row);
NDLI_API ndli_v3 ndli_bed_at(const ndli_bed *bed, const ndli_bed_row *row); /* m, in space */
/* Deformation gradient. */
NDLI_API sb_mat3 ndli_bed_gradient(const ndli_bed *bed, const ndli_place *place, const ndli_bed_row *row);
NDLI_API int ndli_bed_region(const ndli_bed *bed, const ndli_bed_row *row);
/* Edge of a regular tet of the element's size (m). */
NDLI_API double ndli_bed_edge(const ndli_bed *bed, int element);
/* 1: x is in it, as it is now. O(faces). */
NDLI_API int ndli_bed_holds_in_space(const ndli_bed *bed, sb_vec3 x);
/* Where a segment first comes in through the skin, from outside in space, or through where it was before it was taken
 * away; *at: there (m). 0: nowhere. O(faces): for needles that are not in yet. */
NDLI_API int ndli_bed_hit(const ndli_bed *bed, sb_vec3 from, sb_vec3 to, ndli_place *place, sb_vec3 *at);
#endif

#endif /* NDL_BED_H */
