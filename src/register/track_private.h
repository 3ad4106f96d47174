/* track_private: what is inside a reg_track. Floor 6, internal: track_modes.c finds the shapes, track_frame.c takes in
 * what is seen, track_state.c saves it, track.c makes it all and tells of it. */
#ifndef REG_TRACK_PRIVATE_H
#define REG_TRACK_PRIVATE_H

#include "gauss.h"
#include "infer_private.h"
#include "marks.h"
#include "track.h"

enum {
    REGI_TRACK_SPARE = 8,  /* loads beyond the modes, for the search of these */
    REGI_TRACK_PASSES = 2, /* of that search */
    REGI_TRACK_LOOKS = 2,  /* for places, a frame */
    REGI_TRACK_POSE = 6,   /* moves along the axes of the organ and turns about them */
    REGI_TRACK_MODES = 96, /* at most */
    REGI_TRACK_UNKNOWNS = REGI_TRACK_MODES + REGI_TRACK_POSE,
    REGI_TRACK_SURPRISES = 3, /* on end are a jump */
    REGI_TRACK_SCALES = 17,
    REGI_TRACK_WIDE = 5 /* frames that search wide after a start or a jump */
};

/* What deviations are multiplied by when they are told: as those of an inference from views. */
#define REGI_TRACK_ALPHA 1.7

/* What is known between two steps. */
typedef struct regi_track_known {
    double *mean;       /* [modes] amounts of the shapes */
    double *covariance; /* [unknowns][unknowns] of the amounts, of the pose's moves (m) and turns (rad) */
    sb_vec3 place;      /* m: of the organ's middle */
    sb_quat turned;     /* unit: of the organ */
    double time, blind; /* s */
    sb_real noise;      /* m */
    double scale;       /* of the amounts */
    double change;      /* and of what a frame changes of them */
    double evidence[REGI_TRACK_SCALES], change_evidence[REGI_TRACK_SCALES]; /* log, of scales, faded */
    sb_real usual_used, usual_innovation; /* as told of targets lately; 0: not known yet */
    int surprises;                        /* on end */
    int wide;                             /* frames that still search wide */
} regi_track_known;

struct reg_track {
    sb_allocator allocator;
    reg_track_def def; /* resolved: no zeros */
    reg_model *model;
    regi_response response;
    regi_look look;
    sb_surface *tree; /* of the skin, its own: the model's may move meanwhile */
    void *memory;
    int node_count, skin_count, unknowns; /* unknowns: modes + 6 */
    int wide;                             /* what sbi_lanes_are_wide() said */
    regi_track_known known, next;
    sb_vec3 *arms;      /* [nodes] m: from the middle, at the start, in the frame of the start */
    sb_vec3 *modes;     /* [modes][nodes] m */
    sb_vec3 *skin_arms; /* [skin nodes] */
    double *skin_modes; /* [skin nodes][3][modes] m */
    double *spread;     /* [unknowns][unknowns] mean over the nodes of D^T D, D what the unknowns do to a node */
    int *patch_of;      /* [triangles of the skin] */
    double *patch_area; /* [patches] m^2 */
    int patch_count;
    regi_marks marks;    /* landmarks and curves: what waits of them, too */
    sb_vec3 *mark_arms;  /* [marks] m, as arms */
    double *mark_modes;  /* [marks][3][modes] m */
    uint64_t marks_hash; /* of their places at rest */
    int waiting;         /* 1: incoming[] is a target */
    int incoming_count;
    regi_look_point *incoming; /* [most_points] */
    int incoming_has_camera;
    sb_vec3 incoming_camera;
    sb_vec3 *skin;                      /* [skin nodes] where they are (m) */
    double *rows;                       /* [patches + 3 + lines of marks][unknowns] over their deviations */
    double *gaps;                       /* [patches + lines of marks] likewise */
    double *forecast;                   /* [unknowns] of the state, before the target */
    double *state;                      /* [unknowns] of the look at hand: amounts, and the pose's way in this frame */
    double *information, *pull, *whole; /* [unknowns][unknowns] upper half, [unknowns] */
    double *precision, *precise, *column, *turns; /* [unknowns][unknowns] twice, [unknowns]: scratch */
    double pose_precision[REGI_TRACK_POSE * REGI_TRACK_POSE];
    double *small, *diagonal, *beside, *along, *beyond; /* [modes][modes], [modes] */
    double fresh;                                       /* share of this frame in the evidence */
    /* of the search of modes */
    double *root;                    /* [c][c] */
    double *loads;                   /* [modes + SPARE][3 c] */
    double *resultants;              /* [6][3 c] */
    double *gram, *vectors, *values; /* [modes + SPARE]^2 twice, and [3 (modes + SPARE)] */
    sb_vec3 *moved;                  /* [modes + SPARE][nodes] */
    sb_vec3 *tractions;              /* [c] */
    sb_vec3 *shape;                  /* [nodes] displacements, scratch */
};

/* ---- track_modes ---- */
/* Shapes about displacements[nodes], and everything that follows from them; known begins there. Nothing has changed
 * where it fails but scratch. */
REGI_API sb_result regi_track_linearise(reg_track *track, const sb_vec3 *displacements, const sb_real pose_sd[2],
                                        sb_error *error);

/* What follows from arms and modes: those of the skin and of marks, and spread. */
REGI_API void regi_track_derive(reg_track *track);
/* covariance (m^2) of where a node is, in the frame of the target; row: [unknowns] scratch. */
REGI_API void regi_track_covariance_of(const reg_track *track, int node, double *row, sb_mat3 *covariance);

/* ---- track_frame ---- */
/* next: what is known after dt (s) without a target. */
REGI_API void regi_track_predict(reg_track *track, double dt);
/* next: and with what waits, of targets and features. 0: no patch or line of it counts. */
REGI_API sb_result regi_track_take_in(reg_track *track, int *counted, reg_track_info *info);
/* Root mean square error to expect of the nodes (m). */
REGI_API sb_real regi_track_expected(const reg_track *track, const regi_track_known *known);
/* What is open at a start: the amounts by the prior, the pose by sd[2] (m, rad). */
REGI_API void regi_track_open(const reg_track *track, regi_track_known *known, const sb_real sd[2]);

#endif /* REG_TRACK_PRIVATE_H */
