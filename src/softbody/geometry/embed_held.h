/* embed_held: how the points of an embedding that follows a mesh are held. Internal, floor 2.
 *
 * Where several cells have a point, and outside of the mesh, that depends on the changes that led to the mesh: states
 * that are to go on with the same bits keep it, and give it back. */
#ifndef SBI_EMBED_HELD_H
#define SBI_EMBED_HELD_H

#include "embed_follow.h"

/* Of one point. */
typedef struct sbi_embed_held {
    sbi_embed_place place;
    sb_embedded_point info;
} sbi_embed_held;

SBI_API sbi_embed_held sbi_embed_get_held(const sb_embedding *e, int point);
/* 1: the same bits. */
SBI_API int sbi_embed_is_held_so(const sb_embedding *e, int point, const sbi_embed_held *held);

/* All points are held so from now on, in the mesh that it follows: held[point_count] as they were in this mesh. 0: no
 * memory, and nothing has changed. Takes none where nothing changes. */
SBI_API int sbi_embed_hold(sb_embedding *e, const sbi_embed_held *held);

/* Prepares to follow another mesh with its points held so. SB_ERROR_FORMAT: that mesh cannot hold them so;
 * SB_ERROR_MEMORY. After success the next ends it, sbi_embed_drop_prepared, or loading a mesh. */
SBI_API sb_result sbi_embed_prepare(sb_embedding *e, const sbi_embed_slots *mesh, const sbi_embed_held *held,
                                    sb_error *error);
SBI_API void sbi_embed_take_prepared(sb_embedding *e); /* nothing where nothing is prepared */

#endif /* SBI_EMBED_HELD_H */
