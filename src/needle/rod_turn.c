/* rod_turn: minimises a rod's potential over its frames alone. */
#include "band.h"
#include "rod_private.h"

static double ndli_rod_turn_potential(const ndl_rod *rod, const double *theta, double *noise)
{
    ndli_rod_sums sums;
    double potential;
    ndli_rod_set_angles(rod, theta, !rod->plain); /* the bending of a plain rod does not see its frames */
    sums = ndli_rod_shape_energy(rod);
    potential = sums.bend + sums.twist + sums.grip + sums.viscous; /* stretching stays the same, and would drown it */
    *noise = 4.5e-15 * potential + sums.turn_noise;
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        potential -= rod->torque[j] * theta[j];
        *noise += 4.5e-15 * fabs(rod->torque[j] * theta[j]);
    }
    return potential;
}

NDLI_API int ndli_rod_any_turn_held(const ndl_rod *rod)
{
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        if (rod->turn_held[j])
            return 1;
    return 0;
}

NDLI_API int ndli_rod_turn_known(const ndl_rod *rod, int j, int any_held)
{
    return rod->turn_held[j] || (j == 0 && !any_held && rod->plain && rod->grips == 0);
}

NDLI_API double ndli_rod_turn_floor(const ndl_rod *rod, int j) { return 1e-9 * rod->torsion / rod->rest_length[j]; }

/* step_theta = a Newton step for the angles; 0 when the matrix is not positive definite. */
static int ndli_rod_turn_step(ndl_rod *rod, int flags)
{
    int n = ndli_rod_edges(rod), any_held = ndli_rod_any_turn_held(rod);
    ndli_rod_turn_derivatives(rod, flags, rod->turn_gradient, &rod->matrix);
    for (int j = 0; j < n; j++) {
        int known = ndli_rod_turn_known(rod, j, any_held), before = j > 0 && !ndli_rod_turn_known(rod, j - 1, any_held);
        rod->band[2 * j] = !known && before ? rod->matrix.turn_before[j] : 0;
        rod->band[2 * j + 1] = known ? 1 : rod->matrix.turn[j] + ndli_rod_turn_floor(rod, j);
        rod->step_theta[j] = known ? 0 : rod->torque[j] - rod->turn_gradient[j];
    }
    if (ndli_band_factor(rod->band, n, 1, 1e-14) >= 0)
        return 0;
    ndli_band_solve(rod->band, n, 1, rod->step_theta);
    return 1;
}

/* Whether Newton is at an end although its last step was not below what matters: where springs slip angles may be
 * large and their rounding, too. The whole step (largest change, change before) promised no more than noise. */
static int ndli_rod_turns_settled(const ndl_rod *rod, double largest, double before, double noise)
{
    double promised = 0;
    for (int j = 0; j < ndli_rod_edges(rod); j++)
        promised += 0.5 * fabs(rod->step_theta[j] * (rod->torque[j] - rod->turn_gradient[j]));
    return rod->grips > 0 && promised <= noise && largest > 0.25 * before;
}

NDLI_API void ndli_rod_relax(ndl_rod *rod)
{
    size_t bytes = (size_t)ndli_rod_edges(rod) * sizeof(double);
    double noise, potential, before = 0;
    /* at worst one more spring begins to slip in each */
    int most = 50 + 2 * rod->grips;
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    potential = ndli_rod_turn_potential(rod, rod->theta, &noise);
    for (int iteration = 0; iteration < most; iteration++) {
        double size = 1, largest = 0, next = potential;
        if (!ndli_rod_turn_step(rod, NDLI_ROD_EXACT) && !ndli_rod_turn_step(rod, 0))
            break;
        for (int j = 0; j < ndli_rod_edges(rod); j++)
            largest = fmax(largest, fabs(rod->step_theta[j]));
        for (int halving = 0; halving < 30; halving++, size *= 0.5) {
            for (int j = 0; j < ndli_rod_edges(rod); j++)
                rod->try_theta[j] = rod->theta[j] + size * rod->step_theta[j];
            next = ndli_rod_turn_potential(rod, rod->try_theta, &noise);
            if (next <= potential + noise)
                break;
        }
        if (next > potential + noise)
            break;
        memcpy(rod->theta, rod->try_theta, bytes);
        potential = next;
        if (largest < 1e-13 || ndli_rod_turns_settled(rod, largest, before, noise))
            break;
        before = size * largest;
    }
    ndli_rod_set_angles(rod, rod->theta, 1);
}
