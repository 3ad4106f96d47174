/* output: files that are written whole or not at all. Floor 0: calls core and libc.
 *
 *     sb_output out;
 *     if (sb_output_open(&out, "table.csv", &error) == SB_OK) {
 *         fprintf(out.file, "t,force\n");
 *         result = sb_output_close(&out, &error);          // the disk was full: table.csv is what it was before
 *     }
 *
 * What is written goes to a file beside the target, table.csv.0123456789abcdef.part, which takes the target's place
 * once the last byte is written. So a full disk costs neither the file that was there nor leaves a piece of a new
 * one. */
#ifndef SB_OUTPUT_H
#define SB_OUTPUT_H

#include <stdio.h>

#include "core.h"

enum { SB_OUTPUT_PATH = 4096 }; /* bytes of the longest path, with its end */

/* A file being written. */
typedef struct sb_output {
    FILE *file;                  /* for fwrite, fprintf...; their failures are remembered until sb_output_close */
    const char *path;            /* as given, borrowed */
    char target[SB_OUTPUT_PATH]; /* the file itself: where symbolic links lead */
    char beside[SB_OUTPUT_PATH]; /* what is written; empty: the target, where it stands */
} sb_output;

/* Begins to write a file; binary, on every system. path is borrowed until it is closed.
 *
 * A file that is there stays as it is, and readable, until sb_output_close; its permissions pass on to the new one, its
 * hard links stay with the old one, and symbolic links keep pointing to it. It must be writable, and a file can be made
 * in its folder. Devices, pipes and other things that are no plain files are written where they stand.
 *
 * out is written on success and on failure. Nothing is allocated but by fopen. SB_ERROR_ARGUMENT (NULL) or
 * SB_ERROR_FILE: then nothing is to be closed. */
SB_API sb_result sb_output_open(sb_output *out, const char *path, sb_error *error);

/* Ends it. SB_ERROR_FILE when anything could not be written since it was opened, or the target cannot be replaced: then
 * the target is as it was before, and nothing is left beside it. */
SB_API sb_result sb_output_close(sb_output *out, sb_error *error);

/* Ends it without a result: the target is as it was before. */
SB_API void sb_output_discard(sb_output *out);

/* Writes bytes[size] as a file, by the three above: a saved state, recording, needle or preconditioner, say. bytes may
 * be NULL when size is 0. SB_ERROR_ARGUMENT or SB_ERROR_FILE. */
SB_API sb_result sb_file_save(const char *path, const void *bytes, size_t size, sb_error *error);

#endif /* SB_OUTPUT_H */
