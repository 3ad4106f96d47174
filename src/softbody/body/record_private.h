/* record_private: a recording that is played call by call. Floor 3, internal. */
#ifndef SB_RECORD_PRIVATE_H
#define SB_RECORD_PRIVATE_H

#include "body_private.h"
#include "record.h"

/* A place in a recording. The arrays of the command are still encoded. */
typedef struct sbi_record_cursor {
    const sb_recording *recording;
    size_t at; /* behind the command */
    const struct sbi_record_rule *rule;
    sbi_command command; /* ints and reals: set when it is played */
    const unsigned char *ints, *reals;
} sbi_record_cursor;

/* Room for the arguments of the longest command. */
typedef struct sbi_record_scratch {
    int *ints;
    sb_vec3 *vectors; /* reals, in whole vectors */
} sbi_record_scratch;

/* Copies of cursor and *report are a place to go on from, with the body's state there. */
typedef struct sbi_record_player {
    sbi_record_cursor cursor;
    sbi_record_scratch scratch;
    sb_body *body;
    sb_recording_report *report;
} sbi_record_player;

/* What a command is, before it is played. */
typedef struct sbi_record_glance {
    sbi_command_code code;
    int went_well; /* of steps and static solves */
    sb_real dt;    /* of steps (s) */
} sbi_record_glance;

/* Loads the state that the recording began with. As sb_recording_replay; on failure nothing is left to close. */
SBI_API sb_result sbi_record_open(const sb_recording *recording, sb_body *body, sb_recording_report *report,
                                  sbi_record_player *player);
SBI_API void sbi_record_close(sbi_record_player *player);
/* The next command; 0: there is none. */
SBI_API int sbi_record_peek(const sbi_record_player *player, sbi_record_glance *glance);
/* Goes on behind the next command without playing it. */
SBI_API void sbi_record_skip(sbi_record_player *player);
/* Plays the next command, which is there. Errors as sb_recording_replay, in the report. */
SBI_API sb_result sbi_record_play_next(sbi_record_player *player);

#endif /* SB_RECORD_PRIVATE_H */
