/* body_particles: what keeps the motions of particles that their gradients do not see. Floor 3. */
#ifndef SB_BODY_PARTICLES_H
#define SB_BODY_PARTICLES_H

#include "../geometry/particles.h"
#include "body.h"

/* Adds a load (sb_body_remove_load takes it away) that holds the neighbours of every point to the linear field of its
 * gradient: a gradient that is centred on a particle does not see that particle, and one point in a brick does not see
 * its hourglasses. With s_j = u_j - sum_a (phi_a + g_a . (X_j - X_p)) u_a its energy is
 *     alpha / 2 (lambda + 2 mu) w_p sum_j W_j |s_j|^2 / sum_j W_j |X_j - X_p|^2,
 * a constant tangent within that of the body: nothing for linear fields and rigid motions, of any size. alpha: (0, 10];
 * 0.02 is enough. [after Ganzenmueller 2015, in linear form.] Moduli are those of now. body must have been made of
 * particles->mesh and ->domain: SB_ERROR_ARGUMENT where counts differ, alpha is out of range, or with gradients that
 * miss linear fields (SPH, a basis of 1), which it would hold; SB_ERROR_MEMORY. Nothing is added then. */
SB_API sb_result sb_particles_stabilise(const sb_particles *particles, sb_body *body, sb_real alpha, int *load_id,
                                        sb_error *error);

#endif /* SB_BODY_PARTICLES_H */
