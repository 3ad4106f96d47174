/* pieces: what is registered of a body that is cut. Floor 6, internal.
 *
 * All pieces of an element have its shape, one upon the other at rest, so that boundaries of such a mesh are not its
 * skin, and points are to be held by the piece that has their material. */
#ifndef REG_PIECES_H
#define REG_PIECES_H

#include "../softbody/body/body_guest.h"
#include "../softbody/geometry/embed.h"
#include "api.h"

#if defined(REG_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
typedef struct regi_pieces {
    const sb_body *body;
    const sb_mesh *mesh; /* of sbi_body_copy_mesh; both borrowed */
    int *cells;          /* [elements] of the body; NULL: it is not cut */
    sb_allocator allocator;
} regi_pieces;

REGI_API sb_result regi_pieces_make(const sb_body *body, const sb_mesh *mesh, const sb_allocator *allocator,
                                    regi_pieces *pieces, sb_error *error);
REGI_API void regi_pieces_free(regi_pieces *pieces); /* safe on zeros */
/* The element that has the material at xi of an element; where it was taken out, the nearest of its pieces. */
REGI_API int regi_pieces_find(const regi_pieces *pieces, int element, const sb_real xi[3]);
/* The organ's surface without what was taken out: of `surface`, or, where that is NULL, of the mesh before it was cut,
 * with its nodes in skin->nodes. Release with sb_boundary_free. Errors as of sb_mesh_boundary and sb_embedding_create.
 */
REGI_API sb_result regi_pieces_skin(const regi_pieces *pieces, const sb_mesh *surface, sb_boundary *skin,
                                    sb_error *error);
#endif

#endif /* REG_PIECES_H */
