/* needle_bevel: how the way of a tip bends. It turns by the bevel's curvature towards where the bevel looks, while that
 * turns with the needle: exactly over a step (Webster et al. 2006). How far the way may leave the shaft's direction is
 * limited; so soft tissue, in which a shaft bends over a length lam, gives that angle over lam in place of the
 * curvature. */
#include "needle_private.h"

NDLI_API double ndli_bevel_curvature(const ndl_bevel *bevel)
{
    sb_real curvature = bevel->curvature;
    if (bevel->law == NDL_BEVEL_ANGLE)
        (void)ndl_bevel_curvature(bevel, 0, bevel->guide, &curvature);
    return (double)curvature;
}

NDLI_API double ndli_bevel_lag(const ndl_bevel *bevel)
{
    return bevel->law == NDL_BEVEL_ANGLE ? fabs((double)bevel->angle) : (double)bevel->lag;
}

static ndli_v3 ndli_bevel_side(const ndl_needle *needle)
{
    return ndli_from(ndl_rod_frame(needle->rod, needle->rod->node_count - 2).m2);
}

NDLI_API int ndli_bevel_is_coarse(const ndl_needle *needle)
{
    return !needle->site->embeds && needle->line.count > 0 &&
           fabs(ndli_bevel_curvature(&needle->bevel)) * needle->wave > ndli_bevel_lag(&needle->bevel);
}

NDLI_API void ndli_bevel_begin(ndl_needle *needle) { needle->side = ndli_bevel_side(needle); }

/* The end of a shaft has no moment: its last edge, turned on by an eighth of the curvature behind it. An edge longer
 * than the shaft's bends does not show these: there the shaft follows the way that is cut, whose turn within the edge
 * is no lag. */
NDLI_API ndli_v3 ndli_bevel_shaft(const ndl_needle *needle, ndli_v3 heading, ndli_v3 chord)
{
    const ndl_rod *rod = needle->rod;
    int last = rod->node_count - 2;
    double length = rod->rest_length[last], share = length > needle->wave ? needle->wave / length : 1;
    ndli_v3 t = rod->tangent[last], shaft = ndli_madd(t, 1 - share, ndli_sub(heading, chord));
    if (last > 0)
        shaft = ndli_madd(shaft, share * length / (8 * rod->cell[last]), ndli_sub(t, rod->tangent[last - 1]));
    return ndli_scale(1 / ndli_norm(shaft), shaft);
}

/* heading, or the nearest to it that is no farther from the shaft than `lag`. */
static ndli_v3 ndli_bevel_within(ndli_v3 heading, ndli_v3 shaft, double lag)
{
    double along = ndli_dot(heading, shaft), size;
    ndli_v3 aside = ndli_madd(heading, -along, shaft);
    size = ndli_norm(aside);
    if (along > 0 && !(size > lag * along))
        return heading;
    aside = size > 0 ? ndli_madd(shaft, lag / size, aside) : shaft;
    return ndli_scale(1 / ndli_norm(aside), aside);
}

/* A helix from a pose at the origin, as the bevel turns. */
static ndli_pose ndli_bevel_helix(const ndl_needle *needle, ndli_v3 heading, double advance)
{
    ndli_pose pose;
    ndli_v3 after;
    double turn;
    pose.p = ndli_v(0, 0, 0);
    pose.t = heading;
    pose.m2 = ndli_rod_across(needle->side, pose.t);
    pose.m1 = ndli_cross(pose.m2, pose.t);
    after = ndli_rod_across(ndli_bevel_side(needle), pose.t);
    turn = sbi_dense_atan2(ndli_dot(ndli_cross(pose.m2, after), pose.t), ndli_dot(pose.m2, after));
    return ndli_pose_helix(&pose, ndli_bevel_curvature(&needle->bevel), turn / advance, advance);
}

NDLI_API ndli_v3 ndli_bevel_go(const ndl_needle *needle, double advance, ndli_v3 shaft, double lag, ndli_v3 *heading)
{
    ndli_v3 start = ndli_bevel_within(*heading, shaft, lag), way;
    ndli_pose end = ndli_bevel_helix(needle, start, advance);
    *heading = ndli_bevel_within(ndli_scale(1 / ndli_norm(end.t), end.t), shaft, lag);
    if (ndli_dot(*heading, end.t) > (1 - 1e-14) * ndli_norm(end.t))
        return end.p;
    way = ndli_add(start, *heading); /* held back by the shaft: on the way, too */
    return ndli_scale(advance / ndli_norm(way), way);
}
