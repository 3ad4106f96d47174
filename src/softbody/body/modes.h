/* modes: natural frequencies and mode shapes of a body. Floor 3. */
#ifndef SB_MODES_H
#define SB_MODES_H

#include "body.h"

/* How modes are looked for. Start from sb_default_modes_options(). */
typedef struct sb_modes_options {
    sb_mass_kind mass;  /* mass matrix, whatever the body moves with; default SB_MASS_CONSISTENT */
    int at_present;     /* 0 (default): small motions about the undeformed shape without stress; 1: about the
                         * present shape with its exact tangent, stresses included */
    sb_real tolerance;  /* |K x - lambda M x| / lambda in the norm of M^-1, for x of unit mass, (0, 1); default
                         * 1e-8, which makes the error of a frequency far smaller. What is below rounding in K x
                         * counts as that */
    int max_iterations; /* times the space that is searched may grow, >= 1; default 100 */
    unsigned cookie;    /* set by sb_default_modes_options */
} sb_modes_options;

SB_API sb_modes_options sb_default_modes_options(void);

/* What a search did; written on success and on SB_ERROR_NOT_CONVERGED. */
typedef struct sb_modes_info {
    int iterations;     /* times the space grew */
    int solves;         /* linear systems */
    int pcg_iterations; /* of all of them together */
    sb_real residual;   /* the largest of any mode, as the tolerance measures it */
    double seconds;     /* with the body's clock, otherwise 0 */
} sb_modes_info;

/* Finds the lowest `count` natural frequencies of the body with its supports (at rest where they are), constraints
 * (their values play no part), springs and mappings. Other loads play none, but that pressures act at_present: with the
 * symmetric part of their stiffness. Prony terms respond at once, as to the fastest of motions.
 * Free rigid bodies (rigid.h) take part with their masses, about where they were added or, at_present, are now, where
 * the forces on what hangs count with the turning of its arms.
 * count        1 .. degrees of freedom that no support holds and no constraint eliminates; nodes that hang have none,
 *              each free rigid body has six
 * options      NULL: defaults
 * frequencies  [count] (Hz), ascending, multiple ones as often as they are; rigid motions that the supports leave come
 *              out as about 0 (rounding of K x), never as NaN
 * shapes       [count][node_count] or NULL: displacements x (m) of unit modal mass, x^T M x = 1 kg m^2, at right
 *              angles in M, rigid bodies' masses in it; 0 at supported axes; slaves follow their masters
 * info, error  may be NULL
 * Takes memory for about 2 count + 40 vectors from the body's allocator for the time of the call. The body's state is
 * left as it is, to the last bit.
 * Errors: SB_ERROR_ARGUMENT, SB_ERROR_MEMORY, SB_ERROR_INVERTED (at_present, naming the element), SB_ERROR_INDEFINITE
 * (the present shape is not stable: it buckles), SB_ERROR_NOT_CONVERGED naming the mode; frequencies and shapes are
 * then untouched.
 * Method: Rayleigh-Ritz in a space that grows by (K + shift M)^-1 r of the residuals r of the lowest modes not yet
 * found, from random vectors (block Davidson; Parlett 1998, 11 and 13); systems by PCG, loosely. */
SB_API sb_result sb_body_modes(sb_body *body, int count, const sb_modes_options *options, sb_real *frequencies,
                               sb_vec3 *shapes, sb_modes_info *info, sb_error *error);

#endif /* SB_MODES_H */
