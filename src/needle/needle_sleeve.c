/* needle_sleeve: where a needle's sleeve is after a step, and what it feeds and turns. */
#include "needle_private.h"

NDL_API sb_result ndl_needle_move_base(ndl_needle *needle, sb_vec3 base, sb_vec3 direction, sb_vec3 director)
{
    ndli_v3 axis = ndli_from(direction), side = ndli_from(director);
    double length = ndli_norm(axis), width;
    if (!needle)
        return SB_ERROR_ARGUMENT;
    if (!sb_v3_is_finite(base) || !sb_v3_is_finite(direction) || !sb_v3_is_finite(director))
        return SB_ERROR_NOT_FINITE;
    if (!(length > 0))
        return SB_ERROR_ARGUMENT;
    axis = ndli_scale(1 / length, axis);
    width = ndli_norm(side);
    side = ndli_madd(side, -ndli_dot(side, axis), axis);
    if (width > 0 && !(ndli_norm(side) > 1e-6 * width))
        return SB_ERROR_ARGUMENT;
    if (!(1 + ndli_dot(axis, needle->axis) > 0.01))
        return SB_ERROR_ARGUMENT;
    needle->given_outlet = ndli_from(base);
    needle->given_axis = axis;
    needle->given_director = width > 0 ? ndli_scale(1 / ndli_norm(side), side) : side;
    needle->base_given = 1;
    ndli_needle_tell_base(needle, base, direction, director);
    return SB_OK;
}

/* v turned by the angle |w| about w. */
static ndli_v3 ndli_sleeve_turned(ndli_v3 v, ndli_v3 w)
{
    double angle = ndli_norm(w), s, c;
    ndli_v3 n, out;
    if (!(angle > 0))
        return v;
    sbi_dense_sin_cos(angle, &s, &c);
    n = ndli_scale(1 / angle, w);
    out = ndli_madd(ndli_scale(c, v), s, ndli_cross(n, v));
    return ndli_madd(out, (1 - c) * ndli_dot(n, v), n);
}

NDLI_API double ndli_needle_given_turn(const ndl_needle *needle, ndli_v3 axis)
{
    const ndl_rod *rod = needle->rod;
    ndli_v3 d = ndli_rod_transport(rod->tangent[0], axis, rod->director[0]), m1;
    double s, c;
    if (!(ndli_norm(needle->given_director) > 0))
        return 0;
    sbi_dense_sin_cos(rod->theta[0], &s, &c);
    m1 = ndli_madd(ndli_scale(c, d), s, ndli_cross(axis, d));
    return sbi_dense_atan2(ndli_dot(ndli_cross(m1, needle->given_director), axis),
                           ndli_dot(m1, needle->given_director));
}

/* Where the sleeve is after a substep, and how far it turns the needle. */
typedef struct ndli_sleeve {
    ndli_v3 outlet, axis;
    double turn;
} ndli_sleeve;

static ndli_sleeve ndli_sleeve_after(const ndl_needle *needle, const ndl_command *command, double dt, double share)
{
    ndli_v3 spin = ndli_from(command->angular_velocity), swing;
    ndli_sleeve sleeve;
    double along = ndli_dot(spin, needle->axis);
    swing = ndli_madd(spin, -along, needle->axis);
    sleeve.outlet = ndli_madd(needle->outlet, dt, ndli_from(command->velocity));
    sleeve.axis = ndli_sleeve_turned(needle->axis, ndli_scale(dt, swing));
    sleeve.turn = dt * ((double)command->twist + along);
    if (needle->base_given) {
        ndli_v3 axis = ndli_add(sleeve.axis, ndli_scale(share, ndli_sub(needle->given_axis, sleeve.axis)));
        sleeve.outlet = ndli_madd(sleeve.outlet, share, ndli_sub(needle->given_outlet, sleeve.outlet));
        sleeve.axis = axis;
        sleeve.turn += share * ndli_needle_given_turn(needle, ndli_scale(1 / ndli_norm(axis), axis));
    }
    sleeve.axis = ndli_scale(1 / ndli_norm(sleeve.axis), sleeve.axis);
    return sleeve;
}

/* Feeds what is there to be fed: a needle drawn in to its last two edges is held, and so is one without free nodes. */
static void ndli_sleeve_feed(ndl_needle *needle, double length)
{
    ndl_rod *rod = needle->rod;
    double left = rod->rest_length[1] + length;
    if (length == 0)
        return;
    if ((length < 0 && left < 0.2 * needle->edge_length) || (length > 0 && rod->node_count + 4 > rod->capacity) ||
        ndl_rod_feed(rod, (sb_real)length) != SB_OK) {
        needle->limited = 1;
        return;
    }
    needle->fed += length;
}

NDLI_API void ndli_needle_aim(ndl_needle *needle, const ndl_command *command, double dt, double share)
{
    ndl_rod *rod = needle->rod;
    ndli_sleeve sleeve = ndli_sleeve_after(needle, command, dt, share);
    double length = dt * (double)command->insertion;
    needle->pushed = length + ndli_dot(ndli_sub(sleeve.outlet, needle->outlet), sleeve.axis) > 0;
    ndli_sleeve_feed(needle, length);
    rod->target[1] = sleeve.outlet;
    rod->target[0] = ndli_madd(sleeve.outlet, -rod->rest_length[0], sleeve.axis);
    ndli_rod_turn_base(rod, sleeve.turn);
    needle->outlet = sleeve.outlet;
    needle->axis = sleeve.axis;
}
