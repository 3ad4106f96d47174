/* marks: landmarks and lines of an organ (reg_landmark, reg_curve of infer.h): where they are on or in the model, where
 * they are seen, and the gaps between, each along an axis. Floor 6, internal: inferences and trackers make rows of
 * them. */
#ifndef REGI_MARKS_H
#define REGI_MARKS_H

#include "infer.h"
#include "model_private.h"

enum { REGI_MARKS_SAMPLES = 32 }; /* of a curve that is seen, at most */

/* A gap of a landmark, or of a place that a curve is seen at: along an axis. */
typedef struct regi_marks_line {
    int points[2];   /* marks: the organ's place is between these, */
    sb_real share;   /* by so much of the second */
    sb_vec3 axis;    /* unit, in space */
    sb_vec3 seen;    /* m */
    double variance; /* m^2 */
} regi_marks_line;

/* Where a curve is seen. */
typedef struct regi_marks_sample {
    sb_vec3 seen, tangent; /* m; unit */
    double variance;       /* m^2 */
    int first, count;      /* marks: corners of the model's line */
} regi_marks_sample;

typedef struct regi_marks {
    sb_real size;           /* m, of the organ */
    int count;              /* marks: landmarks, then corners of the model's lines */
    int landmark_count;     /* of them */
    int curve_count;        /* of the def, also those that are left out */
    int most_samples;       /* that there is room for */
    int *starts;            /* [curve_count + 1] first mark of each curve */
    int *seen;              /* [landmark_count] 1: it is seen; [curve_count] at how many places a curve is */
    sb_embedding_rows rows; /* of the marks in the mesh */
    sb_vec3 *places;        /* [count] m: at rest, then where they are now */
    regi_marks_line *lines; /* [line_count]: three of each landmark seen, then two of each sample that has a place */
    int fixed_count;        /* lines of landmarks */
    int line_count;
    regi_marks_sample *samples; /* [sample_count] */
    int sample_count;
} regi_marks;

/* Landmarks and curves as a caller has them. */
typedef struct regi_marks_def {
    const reg_landmark *landmarks;
    int landmark_count;
    const reg_curve *curves;
    int curve_count;
    int all; /* 1: also those that count nothing now are marks; 0: they are left out */
} regi_marks_def;

/* Counts, and what is of the model: places, lines. SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE (error->node: the landmark or
 * the curve). */
REGI_API sb_result regi_marks_check_model(const regi_marks_def *def, sb_error *error);
/* What is seen of those that count: finite, of a deviation in range, and within `far` (m) of `about`. Others are not
 * looked at. Errors likewise. */
REGI_API sb_result regi_marks_check_seen(const regi_marks_def *def, sb_vec3 about, sb_real far, sb_error *error);
/* count and most_samples: of what is seen now, or, of `all`, of what may be seen. */
REGI_API void regi_marks_count(regi_marks *marks, const regi_marks_def *def, sb_real size);
/* Lines that there may be. */
REGI_API int regi_marks_most_lines(const regi_marks *marks);
REGI_API void regi_marks_layout(regi_marks *marks, sbi_arena *arena);
/* places, at rest, and rows. SB_ERROR_MEMORY, and what sb_embedding_create says. */
REGI_API sb_result regi_marks_place(regi_marks *marks, const regi_marks_def *def, const sb_mesh *mesh,
                                    const sb_allocator *allocator, const sb_jobs *jobs, sb_error *error);
/* Takes what is seen: the lines of landmarks, and samples of curves. */
REGI_API void regi_marks_see(regi_marks *marks, const regi_marks_def *def);
/* Nothing is. */
REGI_API void regi_marks_forget(regi_marks *marks);
/* What follows from `seen`, the first of each landmark's lines, and the samples' places. */
REGI_API void regi_marks_index(regi_marks *marks);
/* Looks for the samples' places on the model's lines where the marks are now (places): the lines of curves. */
REGI_API void regi_marks_follow(regi_marks *marks);

#endif /* REGI_MARKS_H */
