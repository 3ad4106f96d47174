/* patch: disjoint patches of tets, over each of which the change of volume is averaged. Floor 2, internal.
 *
 * A linear tet whose volume is held has one equation for each, and tets are five times as many as nodes: nothing is
 * left to deform. Of patches of 5 to 10 tets there are fewer than nodes. */
#ifndef SB_PATCH_H
#define SB_PATCH_H

#include "../mesh/mesh.h"

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* Tets of a patch: as many as it is to have, and the least and the most that it may. */
enum { SBI_PATCH_CELLS = 8, SBI_PATCH_LEAST = 5, SBI_PATCH_MOST = 10 };

/* *patches [element_count], to be freed with sbi_free: the patch of each tet4, numbered by their first tets; *count of
 * them. The tets of a patch are connected by faces and of one region. Meshes that generators cut from cells, six or
 * five tets after another that fill a hexahedron, have those cells. Otherwise patches grow from the tet with the fewest
 * free neighbours, by the one with the most nodes and faces in the patch. One has less than 5 where its region has no
 * more in one piece, and more than 10 only where leftovers find no room and none can give a tet. SB_ERROR_MEMORY; of a
 * mesh that is right. */
SBI_API sb_result sbi_patch_make(const sb_mesh *mesh, const sb_allocator *allocator, int **patches, int *count,
                                 sb_error *error);
/* The same where patches have lost and gained tets: patches [element_count] says which each has been in, -1: none. What
 * has come apart is a patch each; those with less than 5 tets find room beside them, or take some, as above. Others
 * stay. */
SBI_API sb_result sbi_patch_follow(const sb_mesh *mesh, const sb_allocator *allocator, int *patches, int *count,
                                   sb_error *error);
#endif

#endif /* SB_PATCH_H */
