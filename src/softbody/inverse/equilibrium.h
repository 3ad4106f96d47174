/* equilibrium: a body's present shape as the solution of r(u, p) = 0, its exact tangent K, and solves with it. Floor 4,
 * internal. The end of a time step is one, too: r then has inertia and damping in it, and K is what they make of it.
 *
 * With constraints u = T u' + b: what is solved is T^T K T on free axes; vectors go in and come out whole. */
#ifndef SB_EQUILIBRIUM_H
#define SB_EQUILIBRIUM_H

#include "../body/step_private.h"
#include "../solve/direct.h"
#include "sensitivity.h"

typedef struct sbi_equilibrium {
    sb_body *body;
    sbi_step step;
    sb_error *error;
    sb_matrix full;    /* K, with rows of supports; its blocks are our own */
    sb_matrix *matrix; /* what is solved: masked, condensed where there are constraints */
    sb_direct *direct; /* or NULL: conjugate gradients with */
    sb_preconditioner *precond;
    int few;               /* right-hand sides that there will be, of which conjugate gradients may be cheaper than a
                            * factor; 0: many, or the factor is wanted for what it tells */
    int skew;              /* 1: pressures may have a part that K leaves out */
    const sb_vec3 *strain; /* [node_count] displacements whose forces by the elements' parameters are dr/dp: those of
                            * the shape, and with damping in proportion to stiffness a share of velocities */
    double tolerance;
    int node_count;
    sb_vec3 *right, *solution, *product, *sum; /* [node_count] scratch of a solve */
} sbi_equilibrium;

/* Checks that the present shape is one and makes K; `few` as above. On failure nothing is left to end. */
SBI_API sb_result sbi_equilibrium_begin(sb_body *body, sb_real tolerance, int few, sbi_equilibrium *eq,
                                        sb_error *error);
/* The same of the shape `end` [node_count] that a step of implicit Euler of dt (s) has led to from the body's present
 * state; until the end of all the body has that shape. SB_ERROR_UNSUPPORTED where r depends on more, see motion.h. */
SBI_API sb_result sbi_equilibrium_begin_step(sb_body *body, sb_real dt, const sb_vec3 *end, sb_real tolerance,
                                             sbi_equilibrium *eq, sb_error *error);
/* Gives all back; the body is as it was. */
SBI_API void sbi_equilibrium_end(sbi_equilibrium *eq);
/* out = K x; with transposed 1 K^T x. They differ by what pressures have at rims. */
SBI_API void sbi_equilibrium_multiply(const sbi_equilibrium *eq, const sb_vec3 *x, int transposed, sb_vec3 *out);
/* v [count][node_count] = T (T^T K T)^-1 T^T v on free axes. A failure leaves v undefined. */
SBI_API sb_result sbi_equilibrium_solve(sbi_equilibrium *eq, int count, int transposed, sb_vec3 *v);
/* v = T^T v, and v = T v. */
SBI_API void sbi_equilibrium_reduce(const sbi_equilibrium *eq, sb_vec3 *v);
SBI_API void sbi_equilibrium_expand(const sbi_equilibrium *eq, sb_vec3 *v);
/* 0 on free axes; 0 on held ones. */
SBI_API void sbi_equilibrium_keep_supports(const sbi_equilibrium *eq, sb_vec3 *v);
SBI_API void sbi_equilibrium_keep_free(const sbi_equilibrium *eq, sb_vec3 *v);

/* sb_body_sensitivities without a factor where there are few parameters and many nodes: instability is noticed by
 * chance only. */
SBI_API sb_result sbi_sensitivities_quick(sb_body *body, const sb_parameter *parameters, int parameter_count,
                                          sb_vec3 *du, sb_vec3 *dreaction, sb_error *error);

/* ---- parameter.c ---- */

/* SB_ERROR_ARGUMENT, SB_ERROR_INDEX, SB_ERROR_UNSUPPORTED, naming parameter number k. */
SBI_API sb_result sbi_parameter_check(const sb_body *body, const sb_parameter *p, int k, sb_error *error);
/* Moduli as the derivatives by them go: all shear constants in proportion. */
SBI_API void sbi_material_set_moduli(sb_material *m, sb_real young, sb_real poisson);
/* A constant that the material has, and what follows from it in lambda, mu, c10 and d1. */
SBI_API void sbi_material_set_constant(sb_material *m, int constant, sb_real value);
/* residual [node_count] = dr/dp at constant u; 0 of supports. Cannot fail once begun and checked. */
SBI_API void sbi_parameter_residual(const sbi_equilibrium *eq, const sb_parameter *p, sb_vec3 *residual);
/* 1 along the axis at the nodes of a support, 0 elsewhere. */
SBI_API void sbi_parameter_motion(const sb_parameter *p, int node_count, sb_vec3 *motion);

#endif /* SB_EQUILIBRIUM_H */
