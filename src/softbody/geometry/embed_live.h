/* embed_live: the mesh in slots that an embedding follows. Internal to embed, floor 2. */
#ifndef SBI_EMBED_LIVE_H
#define SBI_EMBED_LIVE_H

#include "embed_follow.h"

/* Room for so many slots and rows of weights. 0: no memory, all as before. */
SBI_API int sbi_embed_live_room(const sb_embedding *e, sbi_embed_follower *f, int nodes, int cells, int rows);
/* Takes a whole mesh over; there is room for its slots. 0: no memory, and it has none then. */
SBI_API int sbi_embed_live_fill(const sb_embedding *e, sbi_embed_follower *f, const sbi_embed_slots *mesh);
/* Makes f->change, or takes it back; there is room. changed_nodes lists the nodes of its cells afterwards, and marks
 * are set: nodes of cells that change, and these cells. */
SBI_API void sbi_embed_live_apply(sbi_embed_follower *f, const sbi_embed_face *face, int back);
SBI_API void sbi_embed_live_clear_marks(sbi_embed_follower *f);
/* One for the points, without a mesh; NULL: no memory. */
SBI_API sbi_embed_follower *sbi_embed_follower_make(const sb_embedding *e);
SBI_API void sbi_embed_follower_free(const sb_embedding *e, sbi_embed_follower *f); /* NULL is fine */
SBI_API sb_result sbi_embed_follow_no_memory(const sb_embedding *e, sb_error *error);
/* Marks nodes as if they were of a cell that changes. */
SBI_API void sbi_embed_live_mark(sbi_embed_follower *f, const int *nodes, int count);

#endif /* SBI_EMBED_LIVE_H */
