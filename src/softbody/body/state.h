/* state: saves what a body is at and brings it back, to the last bit. Floor 3. */
#ifndef SB_STATE_H
#define SB_STATE_H

#include "body.h"
#include "../base/bytes.h"

/* A saved state holds all that steps and setters change: motion, supports, loads of every kind, constraints, materials,
 * fibres and what Prony terms remember, settings, reactions and the solvers' warm starts. What follows a load is what
 * followed the save, bit for bit, also in another body, process or machine. Loads and constraints come back with the
 * numbers they had, those added since go, those removed since return. Needles and remeshers of a body (needle.h) are
 * saved with it. Points that are drawn on a mesh which has changed (body_embed.h) are placed
 * anew after a load; those of a skin that tools touch are saved with it, too. Only of a body with slack it holds the
 * mesh, as changes have left it; otherwise a state is loaded into a body that was made from the same mesh (and the same
 * table of custom elements) with the same integration, mass, preconditioner and single_rotation, in the same precision;
 * with multigrid also from materials whose stiffness jumps at the same places by the same factors, else what follows
 * differs within the tolerance of the solves.
 *
 * The bytes are little-endian everywhere:
 *     "SBSTATE" 0x1A, version (4 bytes), bytes of sb_real (4), bytes in all (8),
 *     parts: number (4) and values; the first tells the body's make; then those of needles, by name,
 *     checksum of all bytes before it (8). */

/* Bytes that sb_body_state_save writes for this body. Loads, constraints, fibres and Prony terms change it, supports
 * and other numbers of a material do not. 0: more than size_t holds. Cost: proportional to the body. */
SB_API size_t sb_body_state_size(const sb_body *body);

/* Writes the state to buffer[size]; size must be at least sb_body_state_size, what is behind that stays. No allocation.
 * SB_ERROR_ARGUMENT: NULL, or too small a buffer (then untouched). */
SB_API sb_result sb_body_state_save(const sb_body *body, void *buffer, size_t size);

/* Makes the body what it was when buffer[size] was saved. Everything is checked before anything changes:
 * SB_ERROR_FORMAT (no saved state, cut short, too long, damaged, a value out of its range), SB_ERROR_UNSUPPORTED (other
 * version or precision), SB_ERROR_STATE (another body's), SB_ERROR_NOT_FINITE, SB_ERROR_ARGUMENT, SB_ERROR_MATERIAL;
 * SB_ERROR_MEMORY when more room is needed than the allocator gives. On failure the body is as it was. Where supports,
 * materials, loads and constraints need no more room and have the rows they had, nothing is allocated. */
SB_API sb_result sb_body_state_load(sb_body *body, const void *buffer, size_t size, sb_error *error);

/* The same with a file. The body's allocator lends the bytes meanwhile. SB_ERROR_FILE: cannot be opened, read or
 * written; a file that could not be written whole is what it was before: see sb_output_open. */
SB_API sb_result sb_body_state_save_file(const sb_body *body, const char *path, sb_error *error);
SB_API sb_result sb_body_state_load_file(sb_body *body, const char *path, sb_error *error);

/* 64 bits that differ when anything a saved state holds does: equal for equal runs, whatever the machine or the number
 * of threads. No allocation; cost: proportional to the body. */
SB_API uint64_t sb_body_state_hash(const sb_body *body);

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* ---- internal: files of checked bytes -------------------------------------------------------------------- */

/* *image is from the allocator; free it with sbi_free. Stops reading after a head that sbi_image_check would refuse,
 * and one byte after the end that the head tells. */
SBI_API sb_result sbi_image_read_file(const sb_allocator *allocator, const char *path, const char *magic,
                                      uint32_t version, const char *what, unsigned char **image, size_t *size,
                                      sb_error *error);
#endif

#endif /* SB_STATE_H */
