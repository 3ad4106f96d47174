/* record: what a body was told, and whether it does the same again. Floor 3. */
#ifndef SB_RECORD_H
#define SB_RECORD_H

#include "state.h"
#include "step.h"

/* A recording holds a body's state at its start, then every call that changed the body with its arguments, and of every
 * step and static solve the result and a hash of the state it led to. So a session can be played again: on another
 * machine, with another number of threads, or with a library that was meant to compute the same. It works by telling:
 * a body that is not recorded pays one comparison with NULL per call. What register.h
 * does to a body is recorded like the body's own calls, and replays without the registration.
 *
 * Memory: 32 bytes per call and its arguments; 136 more per step. With positions_every = k every k-th step also keeps
 * the displacements (24 bytes per node, in float 12). A sb_body_state_load counts with the whole state it loads. */
typedef struct sb_recording sb_recording;

typedef struct sb_recording_info {
    int commands;  /* calls recorded, steps included */
    int steps;     /* steps and static solves among them */
    int complete;  /* 0: memory ran short, and what came after that is missing */
    int recording; /* 1: still listening to a body */
    size_t bytes;  /* what sb_recording_save writes */
} sb_recording_info;

/* Begins to record a body, from its present state. One recording per body at a time.
 * positions_every  >= 0; 1: displacements of every step, k: of every k-th, the first included; 0: none
 * allocator        of the recording, which grows geometrically; NULL: malloc
 * Recording never makes a call on the body fail: when memory runs short the recording ends there and says so.
 * SB_ERROR_ARGUMENT, SB_ERROR_MEMORY leave *recording untouched. Release with sb_recording_destroy. */
SB_API sb_result sb_recording_start(sb_body *body, int positions_every, const sb_allocator *allocator,
                                    sb_recording **recording, sb_error *error);
/* Stops listening; what was recorded stays. Also happens when the body is destroyed. */
SB_API void sb_recording_stop(sb_recording *recording);
/* Stops and releases; NULL is fine. */
SB_API void sb_recording_destroy(sb_recording *recording);
SB_API sb_recording_info sb_recording_get_info(const sb_recording *recording);

/* ---- files: little-endian like a saved state, with "SBRECORD" at the start ---- */

/* Writes sb_recording_info.bytes to buffer[size]; SB_ERROR_ARGUMENT when it is smaller (then untouched). */
SB_API sb_result sb_recording_save(const sb_recording *recording, void *buffer, size_t size);
/* Makes a recording from what sb_recording_save wrote; whole and unharmed, or SB_ERROR_FORMAT, SB_ERROR_UNSUPPORTED
 * (version, precision), SB_ERROR_MEMORY, SB_ERROR_ARGUMENT, with *recording untouched. */
SB_API sb_result sb_recording_load(const void *buffer, size_t size, const sb_allocator *allocator,
                                   sb_recording **recording, sb_error *error);
/* The same with a file; SB_ERROR_FILE when it cannot be opened, read or written (then it is what it was before). */
SB_API sb_result sb_recording_save_file(const sb_recording *recording, const char *path, sb_error *error);
SB_API sb_result sb_recording_load_file(const char *path, const sb_allocator *allocator, sb_recording **recording,
                                        sb_error *error);

/* ---- playing again ---- */

/* How far a replay came, and where it left the recording's way. Every field is written by every call. */
typedef struct sb_recording_report {
    int commands, steps;                 /* that were played and agreed */
    int step;                            /* the first that differed, from 0; -1: none did */
    sb_result expected, actual;          /* result of that step in the recording and now */
    uint64_t expected_hash, actual_hash; /* of the state after it */
    int first_node, last_node; /* the first displacement that differs is among these: one node where the recording has
                                * positions, else a sixteenth of the nodes; -1: none differs, but something else of
                                * the state does (velocities, warm starts ...) */
    sb_real distance;          /* how far apart they are there (m); -1 where the recording has no positions */
    sb_error error;            /* why the call failed */
} sb_recording_report;

/* Plays a recording on a body made from the same mesh with the same kinds of elements, mass and preconditioner (what
 * else the def says comes with the recording): loads the state it began with, then repeats the calls.
 * SB_OK when every step had its result and its hash. SB_ERROR_STATE: a step differed (the report says which; the body
 * is as that step left it), or the body is not such a one. Another error: a call was refused that had not been (the
 * body is as the calls before left it). SB_ERROR_ARGUMENT: NULL, or the body is the one being recorded. Of an
 * incomplete recording what there is is played. report may be NULL. Takes memory from the recording's allocator for
 * the longest list of arguments, and for constraints from the body's. */
SB_API sb_result sb_recording_replay(const sb_recording *recording, sb_body *body, sb_recording_report *report);

#endif /* SB_RECORD_H */
