/* rod_state: saves what a rod is at, and brings it back to the last bit. Floor 6. */
#ifndef NDL_ROD_STATE_H
#define NDL_ROD_STATE_H

#include "rod.h"

/* For rods that are stepped by themselves: a needle's is part of its body's state (sb_body_state_save).
 *
 * A saved rod holds all that steps, setters and splits change. What follows a load is what followed the save, bit for
 * bit, also in another process or machine with the same order of bytes. It is loaded into a rod that was made from the
 * same def, in the same precision; capacity and allocator may differ.
 *
 * size: bytes that save writes for the rod as it is. save: size must be at least that, what is behind stays; nothing
 * that a step could notice changes, nothing is allocated. load: size may be larger than what was saved; allocates
 * nothing. Buffers need no alignment.
 *
 * Failures leave everything as it was (and `error` may be NULL): SB_ERROR_ARGUMENT (NULL, or too small a buffer);
 * SB_ERROR_FORMAT (no saved rod, cut short, damaged, a count out of its range); SB_ERROR_UNSUPPORTED (other version,
 * precision or order of bytes); SB_ERROR_STATE (another def's, or more nodes than there is room for);
 * SB_ERROR_NOT_FINITE. */
NDL_API size_t ndl_rod_state_size(const ndl_rod *rod);
NDL_API sb_result ndl_rod_save(const ndl_rod *rod, void *buffer, size_t size, sb_error *error);
NDL_API sb_result ndl_rod_load(ndl_rod *rod, const void *buffer, size_t size, sb_error *error);

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
struct sbi_state_out;

/* ---- internal: for undo and for the state of a body ----
 * The same without checks; restoring cannot fail. */
NDLI_API size_t ndli_rod_snapshot_size(const ndl_rod *rod, int node_count); /* when it has so many nodes */
NDLI_API void ndli_rod_snapshot(const ndl_rod *rod, void *buffer);
NDLI_API void ndli_rod_rewind(ndl_rod *rod, const void *buffer);
/* The snapshot as part of a state. */
NDLI_API void ndli_rod_put(const ndl_rod *rod, struct sbi_state_out *out);
/* Whether in[size] begins with a snapshot that the rod may rewind to; used, nodes: its bytes and nodes. */
NDLI_API sb_result ndli_rod_check(const ndl_rod *rod, const unsigned char *in, size_t size, size_t *used, int *nodes,
                                  sb_error *error);
#endif

#endif /* NDL_ROD_STATE_H */
