/* identify: parameters of a body from what was measured of it: Levenberg-Marquardt on exact derivatives, and what the
 * measurements can tell apart. Floor 4.
 *
 * ```c fragment
 * sb_identify_def identify = sb_default_identify_def();
 * sb_parameter young;
 * sb_measurement seen;
 * sb_real value = 3000, deviation; // where to start; what it is good for
 * sb_vec3 tip = sb_v3((sb_real)0.4, (sb_real)0.1, (sb_real)0.08);
 * int start[2] = {0, 1}, node = 44;
 * sb_real weight = 1;
 * sb_mapping row;
 * row.row_count = 1, row.row_start = start, row.nodes = &node, row.weights = &weight;
 * memset(&young, 0, sizeof young);
 * memset(&seen, 0, sizeof seen);
 * young.kind = SB_PARAMETER_YOUNG;
 * seen.rows = &row, seen.points = &tip, seen.sigma_point = (sb_real)1e-4;
 * identify.body = body, identify.parameters = &young, identify.count = 1, identify.measurements = &seen;
 * if (sb_identify(&identify, &value, &deviation, NULL, NULL, &error) != SB_OK)
 *     printf("%s\n", error.message);
 * ```
 *
 * The answer is the set of values with the least sum of squares (reading - model)^2 / sigma^2 near the start. What a
 * number is worth stands beside it: its deviation, the share of its influence on the readings that is its own, and the
 * direction in which values may move together and the readings hardly notice. Read these before the values: a force
 * curve alone, for one, cannot tell the moduli of a core and of its shell apart, and says so by shares of some
 * hundredths (Suwelack 2014, 9.2, finds several solutions there). Where only displacements are read and only
 * displacements are prescribed, moduli scale out: SB_ERROR_INDEFINITE. */
#ifndef SB_IDENTIFY_H
#define SB_IDENTIFY_H

#include "../body/step.h"
#include "sensitivity.h"

/* What was read of one state. Arrays are borrowed for the call. Zero it first. */
typedef struct sb_measurement {
    const sb_mapping *rows; /* points that were followed, by their nodes (sb_embedding has such rows); or NULL */
    const sb_vec3 *points;  /* [rows->row_count] (m) where they are in this state; a coordinate that is NaN was not
                             * read */
    sb_real sigma_point;    /* standard deviation of a coordinate (m), > 0 */
    const int *force_nodes; /* [force_count] supported nodes, whose reactions together are */
    int force_count;        /* 0: no force was read */
    sb_vec3 force;          /* (N) of the supports on the body; a component that is NaN was not read */
    sb_real sigma_force;    /* of a component (N), > 0 */
} sb_measurement;

/* Start from sb_default_identify_def(). */
typedef struct sb_identify_def {
    sb_body *body;
    const sb_parameter *parameters; /* [count] SB_PARAMETER_YOUNG, _POISSON, _CONSTANT, _DENSITY, _GRAVITY, _FORCE,
                                     * _PRESSURE, _STIFFNESS (row SB_AUTO). Moduli, constants, densities and
                                     * stiffnesses stay > 0, Poisson's ratios in (0, 1/2) */
    int count;
    int free_count; /* values that `apply` alone knows what to do with (a size, friction, a place): their
                     * derivatives are differences, two solves of each state. > 0, and stay so. Default 0 */
    const sb_real *low,
        *high;       /* [count + free_count] bounds, which `apply` sees no value beyond; NULL (default): none */
    int state_count; /* >= 1; default 1 */
    const sb_measurement *measurements; /* [state_count] */
    sb_result (*apply)(void *user, int state, const sb_real *free_values, sb_body *body, sb_error *error);
    /* Sets loads and supports of a state (dead loads anew: sb_body_clear_loads), not what `parameters` name; these are
     * set after it, SB_PARAMETER_FORCE in addition to its loads, and taken away again before the next. A result other
     * than SB_OK ends the call. NULL (default): the one state is there */
    void *user;
    int max_iterations;        /* >= 1; default 50 */
    sb_static_options statics; /* of the solves; default tolerance 1e-9 (float 1e-5), forces_only */
    sb_real *correlations;     /* [n][n], n = count + free_count: how deviations of two values go together, -1 to 1 (of
                                * the logarithms, as below); written on success. NULL (default): not wanted */
    sb_real *direction;        /* [n] what each value changes by, in its units and to first order, in the direction that
                                * readings tell least of, when chi2 changes by 1: info.hidden in numbers; written on
                                * success. NULL (default): not wanted */
    unsigned cookie;           /* set by sb_default_identify_def */
} sb_identify_def;

SB_API sb_identify_def sb_default_identify_def(void);

/* sb_identify_info.warnings, as bits. */
enum {
    SB_IDENTIFY_HIDDEN = 1, /* an own share is below 0.01: values answer for each other, see null_direction */
    SB_IDENTIFY_MISFIT = 2, /* chi2 / (readings - values) is not in [1/4, 4]: the model or a sigma is wrong. Deviations
                             * are what the sigmas say, not what the misfit does */
    SB_IDENTIFY_BOUND = 4,  /* a value ended at a bound: its deviation says nothing */
    SB_IDENTIFY_LOCKS = 8   /* elements that lock, and a Poisson's ratio over 0.45: moduli come out too small */
};

typedef struct sb_identify_info {
    int iterations;    /* accepted steps */
    int solves;        /* static solves */
    int readings;      /* coordinates and force components that were read */
    double chi2;       /* sum of ((reading - model) / sigma)^2 at the values */
    double start_chi2; /* and at the start */
    int warnings;
    sb_real weakest; /* the least own share, and whose: */
    int weakest_parameter;
    char hidden[160]; /* the direction that readings tell least of, in words: what changes chi2 by 1 */
} sb_identify_info;

/* Finds values[count + free_count], which come in as the start.
 *   deviations   [count + free_count] standard deviations in the values' units, or NULL
 *   own_shares   [count + free_count] or NULL: of what a value changes in the readings, the share (of its square, in
 *                units of sigma) that no other values could change instead: 1 alone, 0 hidden by the others
 *   info, error  may be NULL
 * Derivatives are those of sb_body_sensitivities; one static solve for each state and trial, from the last accepted
 * shape. The body ends with the values, at the equilibrium of the last state. On failure values and outputs are
 * untouched and the body has its materials, shape and what `parameters` name again, but other loads and supports as
 * `apply` has left them:
 * SB_ERROR_ARGUMENT (the def; a start out of range; YOUNG or POISSON together with CONSTANT of one region),
 * SB_ERROR_UNSUPPORTED (a kind that is not among those above; what sb_body_sensitivities does not derive),
 * SB_ERROR_INDEX, SB_ERROR_NOT_FINITE, SB_ERROR_INDEFINITE (fewer readings than values, or a direction that no reading
 * sees: the message names it), SB_ERROR_NOT_CONVERGED (max_iterations; or no step lowers chi2 any more, far from a
 * minimum), SB_ERROR_MEMORY; what a static solve at the start, or `apply`, fails with.
 * Method: Levenberg-Marquardt in log (nu: nu = 1/2 logistic(q); gravity, forces, pressures as they are), steps of at
 * most 1 there; a trial whose solve fails counts as one that does not help. A value at a bound that would leave stays
 * there, and the others take the step that is best with it there. Ends when chi2 falls by less than 1e-6 of itself or
 * values move by less than 1e-8. */
SB_API sb_result sb_identify(const sb_identify_def *def, sb_real *values, sb_real *deviations, sb_real *own_shares,
                             sb_identify_info *info, sb_error *error);

#endif /* SB_IDENTIFY_H */
