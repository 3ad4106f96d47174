/* cut_fine: a fine skin of the user's own, such as the visual one of an organ, that is cut along with the body.
 * Floor 4.
 *
 *     sb_cut_fine_create(cut, &skin, NULL, &fine, &error);            skin: triangles near the body's boundary, at rest
 *     ... cuts, steps ...
 *     sb_cut_fine_update(fine, &error);                               each frame
 *     drawn = sb_cut_fine_get(fine);
 *
 * Each vertex of the skin moves with the piece of the body's mesh that has its material. An edge of the skin is cut
 * where its ends are on either side of a cut, and where the body is: the skin needs no blades of its own, and follows
 * states that are loaded. A triangle falls into what its cut edges leave: one with one cut edge is slit to its middle,
 * one with two in two, one with three in three. What is open then is closed by what sb_cut_surface draws inside the
 * body, its lips and the walls of holes, and by rims, bands of triangles from the skin's seams to their edges. So what
 * is drawn of a closed skin is watertight after any cuts: by points, each edge is gone along as often one way as the
 * other. Where outlines of the skin and of the body differ, as where a cut is smaller than the skin's triangles or ends
 * between two of them, caps close what rims leave; of the rims of random strokes, slices and burns in livers 2 % are
 * such, or end a cut. open_edges counts the edges of a skin that is open itself, and what cuts make of them.
 *
 * The skin is to be finer than the mesh: edges longer than elements may not see a cut. Material that was taken out goes
 * with the skin's triangles all of whose corners were in it. */
#ifndef SB_CUT_FINE_H
#define SB_CUT_FINE_H

#include "cut_surface.h"

typedef struct sb_cut_fine sb_cut_fine;

/* What a vertex is made from of the user's skin: whatever its vertices have (colours, texture coordinates) goes over by
 * these weights. */
typedef struct sb_cut_fine_source {
    int vertices[3];    /* of the user's skin; [0] -1: the vertex is of a lip or a wall */
    sb_real weights[3]; /* >= 0; they sum to 1 */
} sb_cut_fine_source;

/* Arrays are valid until the next update. */
typedef struct sb_cut_fine_drawing {
    sb_cut_drawing drawn;              /* the skin's vertices first, in their order; those behind them, and triangles,
                                        * are numbered anew after each cut: first_triangle and first_vertex are those of
                                        * all that was. Rims are SB_CUT_RIM. origins of the skin may have weights < 0 */
    const sb_cut_fine_source *sources; /* [drawn.vertex_count] */
    int open_edges;                    /* 0: watertight; so it is where the skin is */
} sb_cut_fine_drawing;

/* A skin for the body that is cut by `cut`, which it is to be destroyed before.
 * skin       SB_TRI3, at rest where the body's mesh is (m), copied
 * allocator  NULL: malloc
 * SB_ERROR_ARGUMENT (other elements), what sb_mesh_validate says of the skin, SB_ERROR_STATE (as sb_cut_triangles),
 * SB_ERROR_MEMORY. Finds the element of each vertex: some 2 us each. */
SB_API sb_result sb_cut_fine_create(sb_cut *cut, const sb_mesh *skin, const sb_allocator *allocator, sb_cut_fine **fine,
                                    sb_error *error);
SB_API void sb_cut_fine_destroy(sb_cut_fine *fine); /* NULL is fine */
/* To what the body is now. Where it was cut since the last call all triangles are listed anew, and arrays may grow;
 * else only vertices move. SB_ERROR_STATE: as sb_cut_triangles. SB_ERROR_MEMORY: what is drawn is what it was, and the
 * next call tries again. */
SB_API sb_result sb_cut_fine_update(sb_cut_fine *fine, sb_error *error);
SB_API sb_cut_fine_drawing sb_cut_fine_get(const sb_cut_fine *fine); /* of NULL: nothing */

#endif /* SB_CUT_FINE_H */
