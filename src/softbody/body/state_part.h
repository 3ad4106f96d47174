/* state_part: what others keep about a body (needles in it, a remesher) and save, restore and record together with it.
 * Floor 3, internal.
 *
 * A body's saved state ends with the parts of those that have joined it, in the order of their names. Its recording
 * holds their commands beside its own: between sbi_body_mute and sbi_body_unmute a part does to the body what it will,
 * then it tells one command, which its `replay` does again. */
#ifndef SB_STATE_PART_H
#define SB_STATE_PART_H

#include "body.h"

#if defined(SB_IMPLEMENTATION) || defined(SB_SPLIT_BUILD)
/* Where a part's bytes go: they are counted, written or hashed. */
typedef struct sbi_state_out {
    unsigned char *bytes; /* NULL: they are not written */
    size_t used;
    int overflow;
    int hashes;
    uint64_t hash;
} sbi_state_out;
SBI_API SBI_NOINLINE void sbi_state_put(sbi_state_out *out, const void *bytes, size_t size);
/* Numbers, the same on every machine: 4 bytes each, and 8. */
SBI_API SBI_NOINLINE void sbi_part_put_int(sbi_state_out *out, int value);
SBI_API void sbi_part_put_reals(sbi_state_out *out, const sb_real *values, int count);

/* What is left to be read of a part; `bad` once it ended too early or held a real that is not finite. */
typedef struct sbi_part_in {
    const unsigned char *bytes;
    size_t left;
    int bad;
} sbi_part_in;
SBI_API sbi_part_in sbi_part_read(const unsigned char *bytes, size_t size);
SBI_API SBI_NOINLINE uint64_t sbi_part_get(sbi_part_in *in, int bytes); /* 1 to 8; 0 where it has ended */
SBI_API SBI_NOINLINE int sbi_part_get_int(sbi_part_in *in);
SBI_API SBI_NOINLINE void sbi_part_get_reals(sbi_part_in *in, sb_real *values,
                                             int count); /* 0 for what is not finite */
/* A number of items, each of at least so many bytes; 0, and bad, where the rest cannot hold them. */
SBI_API int sbi_part_get_count(sbi_part_in *in, int bytes);

typedef struct sbi_state_part {
    char name[9]; /* eight characters at most; each name once in a body */
    int version;  /* of its bytes */
    void *user;
    /* Gives its bytes, the same ones as long as nothing has changed. */
    void (*save)(const void *user, sbi_state_out *out);
    /* Whether it may become what these bytes say, beside a body whose mesh is that of `body`; takes the memory that
     * this needs. Nothing that a step could notice changes. */
    sb_result (*check)(void *user, const sb_body *body, const unsigned char *bytes, size_t size, sb_error *error);
    /* Becomes it; the body has its own state back already, and listeners have followed. */
    void (*load)(void *user, const unsigned char *bytes, size_t size);
    /* After a check, when something else was refused; may be NULL. */
    void (*give_up)(void *user);
    /* Does a recorded command again. */
    sb_result (*replay)(void *user, const int *ints, size_t int_count, const sb_real *reals, size_t real_count,
                        sb_error *error);
} sbi_state_part;

/* From now on the part belongs to the body's state. SB_ERROR_ARGUMENT (no name, or a name that is taken),
 * SB_ERROR_MEMORY. */
SBI_API sb_result sbi_body_join(sb_body *body, const sbi_state_part *part, sb_error *error);
/* No longer; one that has not joined is fine. Parts end with the body, too. */
SBI_API void sbi_body_leave(sb_body *body, const char *name);
/* The user of the part of that name, or NULL: how what several share finds its body's. */
SBI_API void *sbi_body_find_part(const sb_body *body, const char *name);

/* The body's recorder hears nothing until it is unmuted. Calls nest. */
SBI_API void sbi_body_mute(sb_body *body);
SBI_API void sbi_body_unmute(sb_body *body);
/* A command of the part that changes the body or the part. */
SBI_API void sbi_body_tell_part(sb_body *body, const char *name, const int *ints, size_t int_count,
                                const sb_real *reals, size_t real_count);
/* The same of a command that is a step, with its result: also told when it failed. */
SBI_API void sbi_body_tell_part_step(sb_body *body, const char *name, sb_result result, const int *ints,
                                     size_t int_count, const sb_real *reals, size_t real_count);

/* ---- undo ----
 * What a saved state holds, for this body alone: cheap, neither checked nor recorded, and without others' parts. */
SBI_API size_t sbi_body_snapshot_size(const sb_body *body);
/* What a buffer has of the snapshot that was written to it before: parts that have not changed since and lie where they
 * lay are not written again. Zeros: nothing. */
typedef struct sbi_snapshot_held {
    size_t mesh_at, tangent_at; /* bytes before the mesh and the tangent that is kept; 0: not there */
    int mesh_version;
    uint64_t tangent_stamp;
} sbi_snapshot_held;
/* buffer: [sbi_body_snapshot_size], in which others have left alone what `held` was told of; NULL: write all. */
SBI_API void sbi_body_snapshot(const sb_body *body, void *buffer, sbi_snapshot_held *held);
/* Back to it. Allocates (SB_ERROR_MEMORY, nothing changes) only where mesh, loads or constraints have changed since. */
SBI_API sb_result sbi_body_rewind(sb_body *body, const void *snapshot, size_t size, sb_error *error);

/* ---- for state.c and record.c ---- */

typedef struct sbi_state_parts {
    sbi_state_part *list; /* [count] by name */
    int count, capacity;
    int muted;
} sbi_state_parts;

SBI_API void sbi_state_parts_free(sb_body *body);
/* Bytes of all parts as the image has them. */
SBI_API void sbi_state_parts_put(const sb_body *body, sbi_state_out *out);
/* The image's parts, bytes[size], and those of `owner` must be the same, and each takes its own. On failure all have
 * given up. */
SBI_API sb_result sbi_state_parts_check(const sb_body *owner, const sb_body *body, const unsigned char *bytes,
                                        size_t size, sb_error *error);
SBI_API void sbi_state_parts_give_up(const sb_body *owner);
SBI_API void sbi_state_parts_load(const sb_body *owner, const unsigned char *bytes);
/* The first ints of a part's command name it. */
enum { SBI_PART_NAME_INTS = 2 };
SBI_API sb_result sbi_state_parts_replay(sb_body *body, const int *ints, size_t int_count, const sb_real *reals,
                                         size_t real_count, sb_error *error);
#endif

#endif /* SB_STATE_PART_H */
