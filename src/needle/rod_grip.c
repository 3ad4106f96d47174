/* rod_grip: what surrounds a rod holds it against turning: on every edge a torsion spring that slips at its limit
 * (elastic, then perfectly plastic), one end on the rod, the other in the surroundings.
 *
 * A spring is wound by lag = theta - anchor, and its potential is convex: 1/2 k lag^2 up to the lag limit/k, straight
 * beyond. Minimising it together with twist and bending from the anchors of the last state is one implicit step of the
 * plastic flow; the anchors then follow what has slipped. Where the frame that theta is measured from turns by itself
 * (folded reference twist, other nodes), theta and anchor change alike. */
#include "rod_private.h"

NDLI_API double ndli_rod_grip_moment(const ndl_rod *rod, int j, double lag)
{
    double moment = rod->grip[j] * lag, limit = rod->grip_limit[j];
    return moment > limit ? limit : moment < -limit ? -limit : moment;
}

NDLI_API void ndli_rod_add_grip_energy(const ndl_rod *rod, ndli_rod_sums *sums)
{
    double turned = 0, moments = 0;
    for (int i = 1; i < rod->node_count - 1; i++)
        moments += 2 * rod->torsion / rod->cell[i] * fabs(rod->shape.twist[i]);
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        double lag = rod->shape.lag[j], moment = fabs(ndli_rod_grip_moment(rod, j, lag));
        turned = fmax(turned, fabs(lag) + fabs(rod->anchor[j]));
        if (!(rod->grip[j] > 0))
            continue;
        moments += moment;
        sums->grip += moment * (fabs(lag) - 0.5 * moment / rod->grip[j]);
    }
    sums->turn_noise = 2.3e-16 * turned * moments;
}

NDLI_API void ndli_rod_add_grip_derivatives(const ndl_rod *rod, double *turn_gradient, ndli_rod_matrix *matrix)
{
    for (int j = 0; j < ndli_rod_edges(rod); j++) {
        double lag = rod->shape.lag[j];
        turn_gradient[j] += ndli_rod_grip_moment(rod, j, lag);
        if (matrix && rod->grip[j] * fabs(lag) < rod->grip_limit[j])
            matrix->turn[j] += rod->grip[j];
    }
}

NDLI_API void ndli_rod_slip(ndl_rod *rod)
{
    for (int j = 0; j < ndli_rod_edges(rod) && rod->grips > 0; j++) {
        double lag = rod->theta[j] - rod->anchor[j];
        if (!(rod->grip[j] > 0))
            rod->anchor[j] = rod->theta[j];
        else if (rod->grip[j] * fabs(lag) > rod->grip_limit[j])
            rod->anchor[j] = rod->theta[j] - ndli_rod_grip_moment(rod, j, lag) / rod->grip[j];
        rod->shape.lag[j] = rod->theta[j] - rod->anchor[j];
    }
}

NDLI_API void ndli_rod_set_grip(ndl_rod *rod, int edge, double stiffness, double limit)
{
    double lag = rod->theta[edge] - rod->anchor[edge];
    rod->grips += (stiffness > 0) - (rod->grip[edge] > 0);
    if (!(stiffness > 0))
        lag = 0;
    else if (stiffness > rod->grip[edge]) /* what comes to it is not wound */
        lag *= rod->grip[edge] / stiffness;
    rod->grip[edge] = stiffness;
    rod->grip_limit[edge] = stiffness > 0 ? limit : 0;
    if (stiffness * fabs(lag) > limit)
        lag = ndli_rod_grip_moment(rod, edge, lag) / stiffness;
    rod->anchor[edge] = rod->theta[edge] - lag;
    rod->energy_monitored = 0;
}

NDLI_API void ndli_rod_turn_base(ndl_rod *rod, double angle) { rod->theta[0] += angle; }

NDL_API sb_result ndl_rod_set_grip(ndl_rod *rod, int edge, sb_real stiffness, sb_real limit)
{
    if (!rod)
        return SB_ERROR_ARGUMENT;
    if (edge < 0 || edge >= ndli_rod_edges(rod))
        return SB_ERROR_INDEX;
    if (!sb_is_finite(stiffness) || !sb_is_finite(limit))
        return SB_ERROR_NOT_FINITE;
    if (stiffness < 0 || limit < 0)
        return SB_ERROR_ARGUMENT;
    ndli_rod_set_grip(rod, edge, (double)stiffness, (double)limit);
    return SB_OK;
}

NDL_API sb_real ndl_rod_grip_torque(const ndl_rod *rod, int edge)
{
    if (!ndli_rod_has_edge(rod, edge))
        return 0;
    return (sb_real)-ndli_rod_grip_moment(rod, edge, rod->theta[edge] - rod->anchor[edge]);
}

/* ---- carried along where edges change ---- */

NDLI_API void ndli_rod_split_grip(ndl_rod *rod, int edge)
{
    rod->anchor[edge + 1] = rod->anchor[edge];
    rod->grip[edge] *= 0.5;
    rod->grip_limit[edge] *= 0.5;
    rod->grip[edge + 1] = rod->grip[edge];
    rod->grip_limit[edge + 1] = rod->grip_limit[edge];
    rod->grips += rod->grip[edge] > 0;
}

/* The angle of `to` is that of the merged edge already; `lags` are from before. */
NDLI_API void ndli_rod_merge_grip(ndl_rod *rod, int from, int to, const double lags[2])
{
    double sum = rod->grip[from] + rod->grip[to], lag = 0;
    if (sum > 0)
        lag = (rod->grip[from] * lags[0] + rod->grip[to] * lags[1]) / sum;
    rod->grips -= rod->grip[from] > 0 && rod->grip[to] > 0;
    rod->grip[to] = sum;
    rod->grip_limit[to] += rod->grip_limit[from];
    rod->anchor[to] = rod->theta[to] - lag;
}

/* Slope of the lag along gripped edges (rad/m), the lesser of those to both sides: where they differ in sign, or where
 * the grip ends, the lag is flat. Averages of a lag so sloped keep its torque, and do not wash it out. */
static double ndli_rod_lag_slope(const ndl_rod *rod, const double *at, int j)
{
    double slopes[2];
    for (int side = 0; side < 2; side++) {
        int a = j - 1 + side, b = j + side;
        if (a < 0 || b >= ndli_rod_edges(rod) || !(rod->grip[a] > 0) || !(rod->grip[b] > 0))
            return 0;
        slopes[side] = (rod->theta[b] - rod->anchor[b] - rod->theta[a] + rod->anchor[a]) /
                       (0.5 * (at[b + 1] + at[b] - at[a + 1] - at[a]));
    }
    if (!(slopes[0] * slopes[1] > 0))
        return 0;
    return fabs(slopes[0]) < fabs(slopes[1]) ? slopes[0] : slopes[1];
}

NDLI_API void ndli_rod_spread_grip(const ndl_rod *rod, const double *old_at, const double *at, int count,
                                   ndli_rod_spread *spread)
{
    int first = 0;
    for (int k = 0; k < count - 1; k++) {
        double grip = 0, limit = 0, torque = 0;
        for (int j = first; j < ndli_rod_edges(rod) && old_at[j] < at[k + 1]; j++) {
            double from = fmax(at[k], old_at[j]), to = fmin(at[k + 1], old_at[j + 1]);
            double share = (to - from) / (old_at[j + 1] - old_at[j]);
            double off = 0.5 * (from + to - old_at[j] - old_at[j + 1]);
            if (!(share > 0)) {
                first = j; /* passed */
                continue;
            }
            grip += share * rod->grip[j];
            limit += share * rod->grip_limit[j];
            torque +=
                share * rod->grip[j] * (rod->theta[j] - rod->anchor[j] + off * ndli_rod_lag_slope(rod, old_at, j));
        }
        spread->grip[k] = grip;
        spread->limit[k] = limit;
        spread->lag[k] = grip > 0 ? torque / grip : 0;
    }
}
