/* skin: a triangle surface that a body carries along, for others to act on: contact (sb_contact_def.skin). Floor 3.
 *
 *     sb_embedding_create(&def, &embedding, &error);      of the surface's nodes, in the body's mesh
 *     sb_embedding_follow(embedding, body, &error);       where its mesh may change
 *     sb_skin_create(embedding, &surface, NULL, &skin, &error);
 *     contact_def.skin = skin;
 *
 * Each corner of a triangle lies in one cell of the body: its place is x = sum w_a x_a over the cell's nodes, and a
 * force on it goes to them by the same weights. Those of points outside of the mesh are of their cell's map, continued:
 * rows of sb_embedding_mapping. The surface of a cut is a skin, too (sb_cut_surface_skin). */
#ifndef SB_SKIN_H
#define SB_SKIN_H

#include "../geometry/embed.h"

typedef struct sb_skin sb_skin;

/* A skin of triangles between the points of an embedding.
 * embedding  borrowed: destroy the skin first. Follows the body (sb_embedding_follow) where its mesh may change, since
 *            before what acts on the skin was made, and until after that is destroyed
 * surface    tri3, whose nodes are the embedding's points; triangles counter-clockwise seen from outside. Copied
 * allocator  NULL: malloc
 * SB_ERROR_ARGUMENT, SB_ERROR_UNSUPPORTED (other faces than tri3), SB_ERROR_INDEX (error->element: a triangle with a
 * corner that is no point), SB_ERROR_MEMORY; *skin is then untouched. */
SB_API sb_result sb_skin_create(sb_embedding *embedding, const sb_mesh *surface, const sb_allocator *allocator,
                                sb_skin **skin, sb_error *error);
SB_API void sb_skin_destroy(sb_skin *skin); /* NULL is fine, and nothing happens to a cut's */

#endif /* SB_SKIN_H */
