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
    double *scale;                                  /* [count] sqrt of the diagonal of H = J^T J; */
    double *gram, *vectors, *eigenvalues, *scratch; /* [count][count] H of unit diagonal, its eigenvectors; [2 count] */
    double *step, *slope;                           /* [count] dq; J^T misfit */
    sb_vec3 *shapes, *new_shapes;                   /* [states][nodes] displacements */
    sb_vec3 *du, *dreaction;                        /* [parameters][nodes] */
    sb_material *materials;                         /* those of the body at the start */
    sb_vec3 *start;                                 /* [nodes] its displacements there */
    void *memory;
} sbi_identify;

/* ---- identify_state.c ---- */
/* How a value p goes with its q: p by log (1), by 1/2 logistic (2), or as it is (0). */
SBI_API int sbi_identify_way(const sbi_identify *id, int k);
/* dp/dq at p. */
SBI_API double sbi_identify_rate(const sbi_identify *id, int k, double p);
/* p after a step dq from p. */
SBI_API double sbi_identify_move(const sbi_identify *id, int k, double p, double dq);
/* Misfit, slopes and shapes of all states at these values, from the shapes accepted. */
SBI_API sb_result sbi_identify_evaluate(sbi_identify *id, const sb_real *values);
/* misfit [readings] -= readings / sigma. */
SBI_API void sbi_identify_subtract_all(const sbi_identify *id, double *misfit);
/* Has the body's materials again. */
SBI_API void sbi_identify_restore(sbi_identify *id);

/* ---- identify_report.c ---- */
/* Eigenvectors of H at the accepted values. SB_ERROR_INDEFINITE: a value that no reading sees. */
SBI_API sb_result sbi_identify_analyse(sbi_identify *id);
/* SB_ERROR_INDEFINITE naming a direction that no reading sees. */
SBI_API sb_result sbi_identify_check_rank(sbi_identify *id);
SBI_API void sbi_identify_report(sbi_identify *id, sb_real *deviations, sb_real *own_shares);

#endif /* SB_IDENTIFY_PRIVATE_H */
