/* match_private: what is inside a reg_match. Floor 6, internal: match.c makes it, match_step.c moves it. */
#ifndef REG_MATCH_PRIVATE_H
#define REG_MATCH_PRIVATE_H

#include "../softbody/body/body_guest.h"
#include "match.h"

/* Charges per task of the look at the target: fixed, whatever the threads. */
enum { REGI_MATCH_CHUNK = 128 };

/* A charge, or a landmark: a point of an element. Its weights and their gradients at rest are in rows of their own. */
typedef struct regi_match_charge {
    int element;
    int index;      /* triangle, vertex or landmark it is */
    sb_real area;   /* m^2 at rest */
    sb_vec3 normal; /* outward at rest */
    /* of the last look */
    int guess; /* item of the field that was closest, or -1 */
    int active;
    sb_vec3 point;     /* m */
    sb_vec3 force;     /* slope of the potential: of unit charge, away from the target */
    sb_vec3 line;      /* unit vector along which it is stiff */
    sb_real stiffness; /* along it (1/m), >= 0 */
    sb_real distance;  /* m */
    sb_real energy;    /* potential (m) */
} regi_match_charge;

struct reg_match {
    sb_allocator allocator;
    sb_clock clock;
    sb_body *body;
    sb_mesh mesh;             /* the body's at rest: a copy without free cells */
    int mesh_version;         /* of the body's mesh that all of this is about */
    const sb_vec3 *shape;     /* [nodes] displacements at which charges are looked at: the body's, borrowed */
    sbi_potential *potential; /* rows of charges and landmarks */
    double electric;          /* energy of the last look (J) */
    reg_field *field;
    reg_match_method method;
    int partial;
    sb_real size;                    /* of the organ (m) */
    sb_real young;                   /* Pa */
    sb_real rounding;                /* half of the sampling length (m) */
    sb_real first_reach, last_reach; /* m */
    sb_real least_cosine, least_active;
    sb_real first_charge, last_charge, least_growth, most_growth, settled;
    sb_real landmark_stiffness; /* N/m */
    double max_seconds;

    void *memory;                            /* the one block behind the arrays */
    int charge_count, landmark_count, width; /* width: nodes per element */
    regi_match_charge *charges;              /* [charge_count + landmark_count], each kind by element */
    sb_real *weights;                        /* [charges and landmarks][width] */
    sb_vec3 *gradients;                      /* [charges][width] of the weights, at rest (1/m) */
    sb_vec3 *targets;                        /* [landmark_count], in the order of the def */
    sb_vec3 *trial;                          /* [nodes] */
    sb_vec3 *last;                           /* [nodes] increment that the last step at full charge solved for (m) */
    double total_area;
    sb_real volume; /* of the organ at rest (m^3) */

    /* state */
    sb_real charge, reach; /* Young's moduli; m */
    sb_real last_mean;     /* m */
    sb_real relaxation;    /* share of the increment that the last step took; 0: that was not at full charge */
    int calm;              /* steps running that the mean distance did not fall */
    reg_match_info info;
};

/* Where a charge or landmark is now (m). */
REGI_API sb_vec3 regi_match_point(const reg_match *match, int charge);
/* Looks at the target: fills the charges' last look and the distances of the info. Returns the electric energy (J). */
REGI_API double regi_match_look(reg_match *match);
/* sbi_potential_fill of a match: looks, and fills the rows of charges and landmarks. */
REGI_API void regi_match_fill(void *user, const sb_vec3 *u, sb_vec3 *force, sb_real *stiffness, sb_vec3 *lines);
/* trial = the body's shape and the increment[nodes], shortened so that no node moves more than a tenth of the organ's
 * size and until the material admits the shape. On failure match->info.error says why. */
REGI_API sb_result regi_match_shorten(reg_match *match, const sb_vec3 *increment);
/* The nodes of the element that holds a charge or landmark. */
REGI_API const int *regi_match_nodes(const reg_match *match, int charge);

#endif /* REG_MATCH_PRIVATE_H */
