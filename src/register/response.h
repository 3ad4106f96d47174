/* response: how an organ answers to forces where it is now, linearly. Floor 6, internal. */
#ifndef REGI_RESPONSE_H
#define REGI_RESPONSE_H

#include "../softbody/solve/direct.h"
#include "model_private.h"

enum { REGI_RESPONSE_MODES = 6 }; /* rigid motions */

typedef struct regi_response {
    reg_model *model;
    sb_direct *direct;
    sb_vec3 centre;          /* m: turns of the pose are about it; set by the owner */
    int turned;              /* 1: the factor's frame is another: */
    sb_mat3 frame;           /* from it to that of now */
    sb_vec3 *residual;       /* [nodes] internal forces of the shape that was factored (N) */
    sb_vec3 *weighted_modes; /* [MODES][nodes] rigid motions times shares of the mass, */
    sb_vec3 *drift;          /* [MODES][nodes] what these as forces do, */
    sb_vec3 *recoil;         /* [nodes] and what the residual does, like any row that is solved for */
    double drift_system[REGI_RESPONSE_MODES * REGI_RESPONSE_MODES]; /* their products, factored, where nothing holds */
} regi_response;

/* Takes its arrays from an arena. */
REGI_API void regi_response_layout(regi_response *response, int node_count, sbi_arena *arena);
/* Factor and residual of the shape of now. The factor's errors. */
REGI_API sb_result regi_response_factor(regi_response *response, sb_error *error);
/* The same where the organ has its shape at rest, turned as told: the factor is that of the organ at rest, which the
 * model may still have. */
REGI_API sb_result regi_response_factor_turned(regi_response *response, sb_mat3 rotation, sb_error *error);
/* A vector of now in the frame of the factor, and one of that in the frame of now. */
REGI_API sb_vec3 regi_response_to_factor(const regi_response *response, sb_vec3 v);
REGI_API sb_vec3 regi_response_from_factor(const regi_response *response, sb_vec3 v);
/* forces[nodes]: a unit rigid motion times shares of the mass; turns are about the centre and by one over the size. */
REGI_API void regi_response_mode(const regi_response *response, int mode, sb_vec3 *forces);
/* Motions of `count` rows of forces, row[count][nodes], in place: none of what is held, and
 * none of the whole, which is the pose's. */
REGI_API void regi_response_solve(regi_response *response, sb_vec3 *row, int count);

#endif /* REGI_RESPONSE_H */
