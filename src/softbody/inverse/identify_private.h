/* identify_private: what the files of an identification share. Floor 4, internal. */
#ifndef SB_IDENTIFY_PRIVATE_H
#define SB_IDENTIFY_PRIVATE_H

#include "equilibrium.h"
#include "identify.h"

typedef struct sbi_identify {
    const sb_identify_def *def;
    sb_body *body;
    sb_error *error;
    sb_identify_info info;
    int count; /* values, free ones included */
    int readings;
    int nodes;
    sb_real *values, *trial;                        /* [count] accepted, tried */
    double size;                                    /* sum of (reading / sigma)^2 */
    double *misfit, *new_misfit;                    /* [readings] (model - reading) / sigma */
    double *slopes, *new_slopes;                    /* [readings][count] by q */
    double *scale;                                  /* [count] sqrt of the diagonal of H = J^T J */
    double *hessian;                                /* [count][count] H of unit diagonal, its lower triangle; */
    double *gram, *vectors, *eigenvalues, *scratch; /* what is left of it, eigenvectors of its part that is not pinned;
                                                     * [2 count] */
    double *step, *slope;                           /* [count] dq; J^T misfit */
    double *pull;                                   /* [count] what the step is to answer */
    unsigned char *pinned;                          /* [count] 1: the step of this value is as far as it may go */
    sb_vec3 *shapes, *new_shapes;                   /* [states][nodes] displacements */
    sb_vec3 *du, *dreaction;                        /* [parameters][nodes] */
    sb_material *materials;                         /* those of the body at the start */
    sb_vec3 *start;                                 /* [nodes] its displacements there */
    sb_real *loads;                                 /* [count] gravity's component, pressure there */
    sb_real *stiffness;                             /* stiffness of rows there, of one STIFFNESS after the other */
    sb_real *applied;                               /* [count] FORCE that the dead loads have in them now */
    void *memory;
} sbi_identify;

/* ---- identify_state.c ---- */
/* How a value p goes with its q: p by log (1), by 1/2 logistic (2), or as it is (0). */
SBI_API int sbi_identify_way(const sbi_identify *id, int k);
/* dp/dq at p. */
SBI_API double sbi_identify_rate(const sbi_identify *id, int k, double p);
/* The dq from p to a bound above (side 1) or below (-1); infinite where there is none. */
SBI_API double sbi_identify_room(const sbi_identify *id, int k, double p, int side);
/* p after a step dq from p. */
SBI_API double sbi_identify_move(const sbi_identify *id, int k, double p, double dq);
/* Misfit, slopes and shapes of all states at these values, from the shapes accepted. */
SBI_API sb_result sbi_identify_evaluate(sbi_identify *id, const sb_real *values);
/* misfit [readings] -= readings / sigma. */
SBI_API void sbi_identify_subtract_all(const sbi_identify *id, double *misfit);
/* Keeps what of the body the values are put into. */
SBI_API void sbi_identify_keep(sbi_identify *id);
/* Has it again. */
SBI_API void sbi_identify_restore(sbi_identify *id);
/* Rows that the body's STIFFNESS parameters are of. */
SBI_API size_t sbi_identify_rows(const sb_identify_def *def);

/* ---- identify_report.c ---- */
/* H at the accepted values and its eigenvectors. SB_ERROR_INDEFINITE: a value that no reading sees. */
SBI_API sb_result sbi_identify_analyse(sbi_identify *id);
/* Eigenvectors of H with rows and columns of pinned values as if they went with no other. 0: not finite. */
SBI_API int sbi_identify_decompose(sbi_identify *id);
/* SB_ERROR_INDEFINITE naming a direction that no reading sees. */
SBI_API sb_result sbi_identify_check_rank(sbi_identify *id);
SBI_API void sbi_identify_report(sbi_identify *id, sb_real *deviations, sb_real *own_shares);

#endif /* SB_IDENTIFY_PRIVATE_H */
