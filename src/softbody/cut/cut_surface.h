/* cut_surface: what is drawn of a body that is cut: its skin, the lips of the cuts, and the walls of holes. Floor 4.
 *
 *     sb_cut_surface_create(cut, NULL, &surface, &error);
 *     ... cuts, steps ...
 *     sb_cut_surface_update(surface, &error);            each frame
 *     drawn = sb_cut_surface_get(surface);
 *
 * The skin is the boundary of the uncut mesh: a face that is not cut is one triangle, one that is cut falls into
 * triangles along the cut. Lips are the two sides of a cut, with the same triangles turned over, and one common edge
 * where the cut ends in the body. Whole and watertight: by points (below), each edge of a triangle is that of just one
 * other, which goes through it the other way; so each part is a closed surface with its own volume. Where two cuts end
 * in one line, which fronts that are glued (SB_CUT_GLUE) do now and then, others hardly ever, an edge may have four.
 *
 * Vertices keep their numbers: new ones come behind the others, and those that are not used any more stay, unused. Skin
 * and lips have vertices of their own where they meet, so that normals, which are smooth within each of them, are not
 * across their edge. */
#ifndef SB_CUT_SURFACE_H
#define SB_CUT_SURFACE_H

#include "cut.h"

typedef struct sb_cut_surface sb_cut_surface;

typedef enum sb_cut_tag {
    SB_CUT_SKIN = 0, /* the boundary of the uncut mesh */
    SB_CUT_LIP = 1,  /* what a cut laid open */
    SB_CUT_CHAR = 2, /* what ablation did */
    SB_CUT_RIM = 3   /* between a fine skin and what is inside of it (cut_fine.h) */
} sb_cut_tag;

/* What a vertex is made from: whatever nodes of the uncut mesh have (colours, texture coordinates) goes over by these
 * weights. */
typedef struct sb_cut_origin {
    int element; /* of the uncut mesh, as of sb_cut_cell_element; -1: the vertex is not used any more */
    int nodes[4];
    sb_real weights[4]; /* of the nodes, >= 0; they sum to 1 */
} sb_cut_origin;

/* Arrays are valid until the next update. */
typedef struct sb_cut_drawing {
    int vertex_count, triangle_count;
    const sb_vec3 *positions;     /* [vertex_count] in space (m) */
    const sb_vec3 *normals;       /* [vertex_count] unit, out of the tissue */
    const sb_vec3 *rest;          /* [vertex_count] at rest (m): for textures that go through the tissue */
    const sb_real (*texture)[2];  /* [vertex_count] of lips: where they are at rest along the cut (m), with another
                                   * origin where a cut turns by more than 45 degrees; 0 of skin */
    const sb_cut_origin *origins; /* [vertex_count] */
    const int *points;            /* [vertex_count] vertices of skin and of lips at one point have the same number */
    const int (*triangles)[3];    /* [triangle_count] counter-clockwise seen from outside; three times the same vertex:
                                   * none */
    const unsigned char *tags;    /* [triangle_count] SB_CUT_SKIN, SB_CUT_LIP, SB_CUT_CHAR */
    const int *cells;             /* [triangle_count] of the body, that the triangle moves with; -1: none */
    /* What the last update made other than moving vertices: triangles from first to end, and vertices from first on. */
    int first_triangle, triangle_end, first_vertex;
} sb_cut_drawing;

/* The surface of a body that is cut by `cut`, which it is to be destroyed before. allocator NULL: malloc. Has room for
 * the lips of a cut half through the body from the start: 3 MB for 13,000 elements with a lattice of 2.
 * SB_ERROR_ARGUMENT, SB_ERROR_STATE (as sb_cut_triangles), SB_ERROR_MEMORY. */
SB_API sb_result sb_cut_surface_create(sb_cut *cut, const sb_allocator *allocator, sb_cut_surface **surface,
                                       sb_error *error);
SB_API void sb_cut_surface_destroy(sb_cut_surface *surface); /* NULL is fine */
/* To what the body is now. Where it was cut since the last call, the triangles of all elements with cuts are made anew,
 * and arrays may grow; else only vertices move. SB_ERROR_STATE: as sb_cut_triangles. SB_ERROR_MEMORY: what is drawn is
 * not whole, and the next call tries again. */
SB_API sb_result sb_cut_surface_update(sb_cut_surface *surface, sb_error *error);
SB_API sb_cut_drawing sb_cut_surface_get(const sb_cut_surface *surface); /* of NULL: nothing */

#endif /* SB_CUT_SURFACE_H */
