/* body_embed: embeddings that follow the changes of a body's mesh. Floor 3.
 *
 *     sb_embedding_create(&def, &embedding, &error);      from the mesh that the body was made of
 *     sb_embedding_follow(embedding, body, &error);
 *     ... changes, steps, states loaded ...
 *     sb_embedding_update(embedding, sb_body_positions(body), points, normals, NULL); */
#ifndef SB_BODY_EMBED_H
#define SB_BODY_EMBED_H

#include "../geometry/embed.h"
#include "body.h"

/* From now on the embedding follows every change of the body's mesh (sb_body_change_commit) and every state loaded with
 * another mesh. Its node positions are those of the body's slots, sb_body_positions(body); def.mesh need not have their
 * numbers, but has the body's rest shape: points are placed anew where they are at rest.
 * - A point keeps its place at rest, that is its material, to rounding: in the cell made there when its cell was split
 *   or a node slid in the material. Points in cells that did not change have the same bits as before.
 * - A point whose cell was removed is held by the nearest of the cells around the change, as points outside are
 *   (sb_embedding_kind), or by the nearest of all where these do not reach it; sb_embedded_point.lost and
 *   sb_embedding_report.lost say so. It is back inside when cells are made there again.
 * - Points outside that are held where the mesh changed are held anew from their places at rest.
 * - In an element that is cut (sb_cut) a point goes with the piece that has its material, outside with the piece that
 *   has its foot: it is where it was at the instant of the cut. Of a body that has an sb_cut the points are placed by
 *   the first update after a state with another mesh; of one without nobody knows then which piece that is
 *   (sb_body_find_cell), and points of cut elements may be held by the piece on the other side.
 * - After a state with another mesh was loaded the points are placed anew from the mesh at rest: one on a face or
 * outside may be held by another cell than before, and be drawn elsewhere by rounding, or outside by what that cell
 * makes of it. Those of a skin that tools touch (sb_contact_def.skin) are held as they were when the state was saved.
 * - A change that is refused leaves the embedding as it was, to the bit.
 * - A listener (sb_body_listen) finds the embedding changed when its `follow` is called, whichever came first. Between
 *   its `reserve` and that, the embedding is not to be read.
 * Cost: a change searches the points of changed cells and makes anew what updates read of them; points and cells far
 * from it cost nothing (tests/bench/RESULTS.md). The first call takes about as long as the creation. A change allocates
 * when arrays have to grow, and to find a point that no cell around it holds. Without memory the change is refused
 * (SB_ERROR_MEMORY). After a state was loaded without memory for this, the next sb_embedding_update or
 * sb_embedding_forces tries again and says SB_ERROR_MEMORY in turn. It ends with either of the two, or
 * sb_embedding_unfollow. SB_ERROR_ARGUMENT (NULL, or other elements than the body's), SB_ERROR_STATE (it follows a body
 * already), SB_ERROR_UNSUPPORTED (def.slack was 0), SB_ERROR_MEMORY leave it as it was. */
SB_API sb_result sb_embedding_follow(sb_embedding *embedding, sb_body *body, sb_error *error);
/* It stays as it is, and does not follow any more. SB_ERROR_STATE: it follows no body. SB_ERROR_ARGUMENT: NULL. */
SB_API sb_result sb_embedding_unfollow(sb_embedding *embedding);

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* ---- internal: the mesh of a body with slack, as an embedding takes it ---- */
struct sbi_embed_slots;
SBI_API void sbi_body_fill_embed_slots(const sb_body *body, struct sbi_embed_slots *mesh);
#endif

#endif /* SB_BODY_EMBED_H */
