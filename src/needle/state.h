/* state: saves what a remesher or a rod is at, and brings it back to the last bit. Floor 6. */
#ifndef NDL_STATE_H
#define NDL_STATE_H

#include "remesh.h"
#include "rod.h"

/* A saved state holds all that steps, setters and remeshing change. What follows a load is what followed the save, bit for
 * bit, whatever has been split, mended or grown in between, and also in another object, process or machine with the same
 * order of bytes. A state is loaded into an object that was made from the same mesh and the same def, in the same precision;
 * allocator and slack may differ.
 *
 * A remesher's state belongs with that of the body whose mesh it changes: save both at the same time, and load the body's
 * first (sb_body_state_load). A remesher refuses a state that was saved with another mesh than its body now has. Loading a
 * body's state with another mesh alone leaves its remeshers without needles: the mesh that came is the original one then.
 *
 * size: bytes that save writes for the object as it is; splits make it grow. save: size must be at least that, what is
 * behind stays; nothing that a step could notice changes, nothing is allocated. load: size may be larger than what was
 * saved. Buffers need no alignment. Cost of each: proportional to the object.
 *
 * Failures leave everything as it was (and `error` may be NULL): SB_ERROR_ARGUMENT (NULL, or too small a buffer);
 * SB_ERROR_FORMAT (no state of this kind, cut short, damaged, an index or value out of its range);
 * SB_ERROR_UNSUPPORTED (other version, precision or order of bytes); SB_ERROR_STATE (another
 * object's, or a remesher's that does not fit its body); SB_ERROR_NOT_FINITE; SB_ERROR_MEMORY: loading needs more
 * room than the allocator gives, or, at a save, a change of the mesh found no memory for the matrix and no step has
 * made it up yet. A load allocates where the object has less room than the state needs; a remesher's takes a copy of
 * the topology for the time of the call, on which it undoes all splits before it trusts them. */
NDL_API size_t ndl_remesh_state_size(const ndl_remesh *remesh);
NDL_API sb_result ndl_remesh_save(const ndl_remesh *remesh, void *buffer, size_t size, sb_error *error);
NDL_API sb_result ndl_remesh_load(ndl_remesh *remesh, const void *buffer, size_t size, sb_error *error);

NDL_API size_t ndl_rod_state_size(const ndl_rod *rod);
NDL_API sb_result ndl_rod_save(const ndl_rod *rod, void *buffer, size_t size, sb_error *error);
NDL_API sb_result ndl_rod_load(ndl_rod *rod, const void *buffer, size_t size, sb_error *error);

#if defined(NDL_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* ---- internal: undo ----
 * The same without checks: into memory of at least the snapshot's size that is aligned for a double, and back into the
 * object it is from. Restoring cannot fail and allocates nothing that it could not do without. */
NDLI_API size_t ndli_remesh_snapshot_size(const ndl_remesh *r);
NDLI_API size_t ndli_remesh_snapshot_room(const ndl_remesh *r); /* most, while the needles keep to what was reserved */
NDLI_API void ndli_remesh_snapshot(const ndl_remesh *r, void *buffer);
NDLI_API void ndli_remesh_rewind(ndl_remesh *r, const void *buffer);
NDLI_API size_t ndli_rod_snapshot_size(const ndl_rod *rod, int node_count); /* when it has so many nodes */
NDLI_API void ndli_rod_snapshot(const ndl_rod *rod, void *buffer);
NDLI_API void ndli_rod_rewind(ndl_rod *rod, const void *buffer);
#endif

#endif /* NDL_STATE_H */
