/* icp_side: the shapes of an alignment: which of their points look, which way their normals point. */
#include "icp_private.h"

enum {
    REGI_ICP_FITTED = 6000, /* more points than these are thinned before normals are fitted */
    REGI_ICP_NEIGHBOURS = 16,
    REGI_ICP_NEAR = 9, /* neighbours that tell whether a point is isolated */
    REGI_ICP_CROWD = 4 * REGI_ICP_FINE
};

static void regi_icp_set_free(const sb_allocator *allocator, regi_icp_set *set)
{
    sbi_free(allocator, set->points);
    sbi_free(allocator, set->normals);
    sbi_free(allocator, set->weights);
    sbi_free(allocator, set->partner);
}

REGI_API void regi_icp_side_free(const sb_allocator *allocator, regi_icp_side *side)
{
    reg_kdtree_destroy(side->own_tree);
    reg_kdtree_destroy(side->spread_tree);
    reg_cloud_free(&side->own);
    sbi_free(allocator, side->own_weights);
    regi_icp_set_free(allocator, &side->sample);
    regi_icp_set_free(allocator, &side->spread);
}

REGI_API sb_result regi_icp_no_memory(const regi_icp *icp)
{
    return sbi_fail(icp->error, SB_ERROR_MEMORY, "no memory to align the shapes");
}

static int regi_icp_set_allocate(const sb_allocator *allocator, regi_icp_set *set, int count)
{
    set->count = count;
    set->points = (sb_vec3 *)sbi_alloc(allocator, (size_t)count, sizeof(sb_vec3));
    set->normals = (sb_vec3 *)sbi_alloc(allocator, (size_t)count, sizeof(sb_vec3));
    set->weights = (sb_real *)sbi_alloc(allocator, (size_t)count, sizeof(sb_real));
    set->partner = (int *)sbi_alloc_zeroed(allocator, (size_t)count, sizeof(int));
    return set->points && set->normals && set->weights && set->partner;
}

/* Every so-maniest point in the order of the tree, in which neighbours are neighbours: indices[wanted],
 * wanted <= count. 0 without memory. */
static int regi_icp_stride(const regi_icp *icp, const regi_icp_side *side, int wanted, int *indices)
{
    int *order = (int *)sbi_alloc(icp->allocator, (size_t)side->count, sizeof(int));
    if (!order)
        return 0;
    regi_kdtree_order(side->tree, order);
    for (int i = 0; i < wanted; i++)
        indices[i] = order[(int64_t)i * side->count / wanted];
    sbi_free(icp->allocator, order);
    return 1;
}

REGI_API sb_real regi_icp_weight(const regi_icp_side *side, int point)
{
    sb_real weight = side->weights ? side->weights[point] : 1, sure;
    if (!side->sd)
        return weight;
    sure = side->usual_sd / side->sd[point];
    return weight * sb_min(sure * sure, 1 / SB_EPSILON);
}

/* How many of the side's points are where this one is, itself included; 16 at most. */
static int regi_icp_copies(const regi_icp_side *side, int point)
{
    int indices[16], found = 0;
    sb_real squared[16];
    for (int k = 2; k <= 16; k *= 8) { /* few have any */
        found = reg_kdtree_k_nearest(side->tree, side->points[point], k, indices, squared);
        while (found > 1 && squared[found - 1] > 0)
            found--;
        if (found < k)
            break;
    }
    return sbi_max_int(found, 1);
}

/* The side's points chosen[count] (NULL: the first ones) as a set. */
static sb_result regi_icp_take(const regi_icp *icp, const regi_icp_side *side, const int *chosen, int count,
                               regi_icp_set *set)
{
    if (!regi_icp_set_allocate(icp->allocator, set, count))
        return regi_icp_no_memory(icp);
    for (int i = 0; i < count; i++) {
        int at = chosen ? chosen[i] : i;
        set->points[i] = side->points[at];
        set->normals[i] = sb_v3_scale((sb_real)side->sign, side->normals[at]);
        set->weights[i] = regi_icp_weight(side, at) / (sb_real)regi_icp_copies(side, at);
    }
    return SB_OK;
}

/* The points that look in the last stage: as dense as the shape's own. */
static sb_result regi_icp_sample(const regi_icp *icp, const regi_icp_side *side, int wanted, regi_icp_set *set)
{
    int *chosen;
    sb_result result;
    if (wanted >= side->count)
        return regi_icp_take(icp, side, NULL, side->count, set);
    chosen = (int *)sbi_alloc(icp->allocator, (size_t)wanted, sizeof(int));
    result = chosen && regi_icp_stride(icp, side, wanted, chosen) ? regi_icp_take(icp, side, chosen, wanted, set)
                                                                  : regi_icp_no_memory(icp);
    sbi_free(icp->allocator, chosen);
    return result;
}

/* ---- isolated points ------------------------------------------------------------------------------------------------
 * Farthest points are chosen first where points are spread: outliers before all others. So they go before. */

/* Of points[count] (at least one): the distance to the ninth neighbour (infinite where all are in one place), and
 * (normals not NULL) the mean normal of all of these, into smooth[count]: normals of noisy facets are none, those of a
 * patch are. */
static sb_result regi_icp_neighbours(const regi_icp *icp, const sb_vec3 *points, const sb_vec3 *normals, int count,
                                     sb_real *reach, sb_vec3 *smooth)
{
    int indices[REGI_ICP_NEAR + 1];
    sb_real squared[REGI_ICP_NEAR + 1];
    reg_kdtree *tree = NULL;
    sb_result result = reg_kdtree_create(points, count, icp->allocator, &tree, icp->error);
    for (int i = 0; result == SB_OK && i < count; i++) {
        int found = reg_kdtree_k_nearest(tree, points[i], REGI_ICP_NEAR + 1, indices, squared);
        sb_vec3 sum = sb_v3(0, 0, 0);
        reach[i] = found > 0 && squared[found - 1] > 0 ? sb_sqrt(squared[found - 1]) : (sb_real)INFINITY;
        for (int k = 0; normals && k < found; k++)
            sum = sb_v3_add(sum, normals[indices[k]]);
        if (normals) /* both sides of a thin part, or no direction at all: better the point's own */
            smooth[i] = sb_v3_norm(sum) > (sb_real)0.3 * (sb_real)found ? regi_cloud_unit(sum) : normals[i];
    }
    reg_kdtree_destroy(tree);
    return result;
}

/* Leaves of chosen[count] those whose reach is at most three medians; smooth[count] (or NULL) goes with them. Returns
 * how many. */
static int regi_icp_keep_near(int *chosen, sb_vec3 *points, sb_vec3 *smooth, const sb_real *reach, int count,
                              sb_real *scratch)
{
    sb_real limit = 3 * reg_outlier_limit(reach, count, REG_OUTLIERS_TRIM, (sb_real)0.5, scratch);
    int kept = 0;
    for (int i = 0; i < count; i++)
        if (reach[i] <= limit || !sb_is_finite(reach[i])) {
            chosen[kept] = chosen[i];
            points[kept] = points[i];
            if (smooth)
                smooth[kept] = smooth[i];
            kept++;
        }
    return kept;
}

/* What the search's points are chosen from. */
typedef struct regi_icp_crowd {
    int *chosen; /* [count] of the side's points */
    sb_vec3 *points, *normals;
    sb_real *reach, *scratch;
    int count;
} regi_icp_crowd;

static int regi_icp_crowd_allocate(const regi_icp *icp, regi_icp_crowd *crowd, int count)
{
    size_t n = (size_t)count;
    crowd->count = count;
    crowd->chosen = (int *)sbi_alloc(icp->allocator, n, 2 * sizeof(int));
    crowd->points = (sb_vec3 *)sbi_alloc(icp->allocator, n, 3 * sizeof(sb_vec3));
    crowd->reach = (sb_real *)sbi_alloc(icp->allocator, n, 2 * sizeof(sb_real));
    crowd->normals = crowd->points + n;
    crowd->scratch = crowd->reach + n;
    return crowd->chosen && crowd->points && crowd->reach;
}

static void regi_icp_crowd_free(const regi_icp *icp, regi_icp_crowd *crowd)
{
    sbi_free(icp->allocator, crowd->chosen);
    sbi_free(icp->allocator, crowd->points);
    sbi_free(icp->allocator, crowd->reach);
}

/* The side's points without those of weight 0 and, but for a closed surface, isolated ones; normals smoothed. */
static sb_result regi_icp_gather(const regi_icp *icp, const regi_icp_side *side, regi_icp_crowd *crowd)
{
    sb_result result = SB_OK;
    int weighed = 0;
    if (!regi_icp_stride(icp, side, crowd->count, crowd->chosen))
        return regi_icp_no_memory(icp);
    for (int i = 0; i < crowd->count; i++)
        if (regi_icp_weight(side, crowd->chosen[i]) > 0)
            crowd->chosen[weighed++] = crowd->chosen[i];
    crowd->count = weighed > 0 ? weighed : crowd->count;
    for (int i = 0; i < crowd->count; i++) {
        crowd->points[i] = side->points[crowd->chosen[i]];
        crowd->normals[i] = side->normals[crowd->chosen[i]];
    }
    if (!side->closed && !side->cleaned) {
        sb_vec3 *smooth = crowd->normals + crowd->count;
        result = regi_icp_neighbours(icp, crowd->points, crowd->normals, crowd->count, crowd->reach, smooth);
        if (result == SB_OK) {
            memcpy(crowd->normals, smooth, (size_t)crowd->count * sizeof(sb_vec3));
            crowd->count = regi_icp_keep_near(crowd->chosen, crowd->points, crowd->normals, crowd->reach, crowd->count,
                                              crowd->scratch);
        }
    }
    return result;
}

/* The points of the search, evenly spread whatever the shape's density, out of four times as many. */
static sb_result regi_icp_spread(const regi_icp *icp, const regi_icp_side *side, regi_icp_set *set)
{
    regi_icp_crowd crowd;
    sb_result result = regi_icp_crowd_allocate(icp, &crowd, sbi_min_int(side->count, REGI_ICP_CROWD))
                           ? regi_icp_gather(icp, side, &crowd)
                           : regi_icp_no_memory(icp);
    if (result == SB_OK) {
        int *best = crowd.chosen + crowd.count;
        int count =
            reg_cloud_spread(crowd.points, crowd.count, sbi_min_int(crowd.count, REGI_ICP_FINE), best, crowd.scratch);
        if (!regi_icp_set_allocate(icp->allocator, set, count))
            result = regi_icp_no_memory(icp);
        for (int i = 0; result == SB_OK && i < count; i++) {
            set->points[i] = crowd.points[best[i]];
            set->normals[i] = sb_v3_scale((sb_real)side->sign, crowd.normals[best[i]]);
            set->weights[i] = regi_icp_weight(side, crowd.chosen[best[i]]);
        }
    }
    regi_icp_crowd_free(icp, &crowd);
    return result;
}

/* ---- normals ----------------------------------------------------------------------------------------------------- */

/* The side becomes its points chosen[count], with memory of its own. */
static sb_result regi_icp_own(const regi_icp *icp, regi_icp_side *side, const int *chosen, int count)
{
    reg_kdtree *tree = NULL;
    sb_result result = regi_cloud_allocate(&side->own, count, 0, icp->allocator, icp->error);
    if (result == SB_OK) {
        side->own_weights = (sb_real *)sbi_alloc(icp->allocator, (size_t)count, sizeof(sb_real));
        result = side->own_weights ? SB_OK : regi_icp_no_memory(icp);
    }
    for (int i = 0; result == SB_OK && i < count; i++) {
        side->own.points[i] = side->points[chosen[i]];
        side->own_weights[i] = regi_icp_weight(side, chosen[i]);
    }
    if (result == SB_OK)
        result = reg_kdtree_create(side->own.points, count, icp->allocator, &tree, icp->error);
    if (result != SB_OK)
        return result;
    reg_kdtree_destroy(side->own_tree);
    side->own_tree = tree;
    side->tree = tree;
    side->points = side->own.points;
    side->weights = side->own_weights;
    side->sd = NULL;
    side->count = count;
    return SB_OK;
}

/* The side's points in their order, of several in one place the first: chosen[side->count]. Returns how many. */
static int regi_icp_places(const regi_icp_side *side, int *chosen)
{
    int count = 0;
    for (int i = 0; i < side->count; i++)
        if (reg_kdtree_nearest(side->tree, side->points[i], SB_REAL_MAX, NULL) == i)
            chosen[count++] = i;
    return count;
}

/* Where normals have to be fitted: to fewer points when there are very many, and without isolated ones. */
static sb_result regi_icp_reduce(const regi_icp *icp, regi_icp_side *side)
{
    regi_icp_crowd crowd;
    sb_result result = regi_icp_crowd_allocate(icp, &crowd, sbi_min_int(side->count, REGI_ICP_FITTED)) &&
                               regi_icp_stride(icp, side, crowd.count, crowd.chosen)
                           ? SB_OK
                           : regi_icp_no_memory(icp);
    if (result == SB_OK) {
        if (crowd.count == side->count)
            crowd.count = regi_icp_places(side, crowd.chosen);
        for (int i = 0; i < crowd.count; i++)
            crowd.points[i] = side->points[crowd.chosen[i]];
        result = regi_icp_neighbours(icp, crowd.points, NULL, crowd.count, crowd.reach, NULL);
    }
    if (result == SB_OK) {
        int kept = regi_icp_keep_near(crowd.chosen, crowd.points, NULL, crowd.reach, crowd.count, crowd.scratch);
        result = regi_icp_own(icp, side, crowd.chosen, kept);
        side->cleaned = 1;
    }
    regi_icp_crowd_free(icp, &crowd);
    return result;
}

/* Normals across planes through neighbours: towards the camera, else either way. */
static sb_result regi_icp_fit_normals(const regi_icp *icp, const reg_icp_shape *shape, regi_icp_side *side)
{
    sb_result result = regi_icp_reduce(icp, side);
    side->surface = NULL;
    side->fitted = 1;
    side->unsure = !shape->has_camera;
    if (result == SB_OK)
        result = reg_cloud_estimate_normals(&side->own, REGI_ICP_NEIGHBOURS, shape->has_camera ? &shape->camera : NULL,
                                            NULL, icp->error);
    side->normals = side->own.normals;
    return result;
}

static sb_result regi_icp_surface_normals(const regi_icp *icp, regi_icp_side *side)
{
    sb_result result = regi_cloud_allocate(&side->own, side->count, 1, icp->allocator, icp->error);
    for (int i = 0; result == SB_OK && i < side->count; i++) {
        sb_surface_hit hit;
        sb_surface_closest(side->surface, side->points[i], SB_REAL_MAX, &hit);
        side->own.normals[i] = sb_surface_normal(side->surface, &hit);
    }
    side->normals = side->own.normals;
    return result;
}

/* -1 when a closed surface's normals point inwards: what is seen of it from far outside, on six sides, looks away. */
static int regi_icp_outward(const sb_surface *surface)
{
    sb_vec3 low, high, middle;
    sb_real far_off;
    int votes = 0;
    sb_surface_bounds(surface, &low, &high);
    middle = sb_v3_scale((sb_real)0.5, sb_v3_add(low, high));
    far_off = 2 * sb_v3_norm(sb_v3_sub(high, low));
    for (int i = 0; i < 6; i++) {
        sb_real step = i % 2 ? far_off : -far_off, towards;
        sb_vec3 from = sb_v3_add(middle, sb_v3(i / 2 == 0 ? step : 0, i / 2 == 1 ? step : 0, i / 2 == 2 ? step : 0));
        sb_surface_hit hit;
        if (!sb_surface_closest(surface, from, SB_REAL_MAX, &hit))
            continue;
        towards = sb_v3_dot(sb_surface_normal(surface, &hit), sb_v3_sub(from, hit.point));
        votes += towards > 0 ? 1 : towards < 0 ? -1 : 0;
    }
    return votes < 0 ? -1 : 1;
}

/* Normals that a cloud brings, as means over neighbours where they are noisy: half of them over 15 degrees off these
 * means. Of very many points they are taken as they are. */
static sb_result regi_icp_smooth_normals(const regi_icp *icp, regi_icp_side *side)
{
    const sb_real even = (sb_real)0.034;
    sb_real *reach;
    sb_result result;
    if (side->surface || side->count > REGI_ICP_FITTED)
        return SB_OK;
    result = regi_cloud_allocate(&side->own, side->count, 1, icp->allocator, icp->error);
    if (result != SB_OK)
        return result;
    reach = (sb_real *)sbi_alloc(icp->allocator, (size_t)side->count, 2 * sizeof(sb_real));
    result = reach ? regi_icp_neighbours(icp, side->points, side->normals, side->count, reach, side->own.normals)
                   : regi_icp_no_memory(icp);
    if (result == SB_OK) {
        for (int i = 0; i < side->count; i++)
            reach[i] = 1 - sb_v3_dot(side->normals[i], side->own.normals[i]);
        if (reg_outlier_limit(reach, side->count, REG_OUTLIERS_TRIM, (sb_real)0.5, reach + side->count) > even)
            side->normals = side->own.normals;
    }
    sbi_free(icp->allocator, reach);
    return result;
}

/* Share of the normals that look away from the camera. */
static sb_real regi_icp_away(const regi_icp_side *side, sb_vec3 camera)
{
    int away = 0, known = 0;
    for (int i = 0; i < side->count; i++) {
        sb_real towards = sb_v3_dot(side->normals[i], sb_v3_sub(camera, side->points[i]));
        known += towards < 0 || towards > 0;
        away += towards < 0;
    }
    return known > 0 ? (sb_real)away / (sb_real)known : (sb_real)0.5;
}

/* Normals, and which way they point: a closed surface has an outside, a camera sees outsides only; else both ways are
 * tried. */
static sb_result regi_icp_normals(regi_icp *icp, const reg_icp_shape *shape, regi_icp_side *side)
{
    const sb_real few = (sb_real)0.1;
    sb_result result = SB_OK;
    sb_real away;
    side->sign = 1;
    side->closed = side->surface && sb_surface_is_closed(side->surface);
    if (!side->normals && !side->surface)
        return regi_icp_fit_normals(icp, shape, side);
    if (!side->normals)
        result = regi_icp_surface_normals(icp, side);
    if (result != SB_OK)
        return result;
    if (side->closed) {
        side->sign = regi_icp_outward(side->surface);
    } else if (shape->has_camera) {
        away = regi_icp_away(side, shape->camera);
        side->sign = away >= 1 - few ? -1 : 1;
        if (away > few && away < 1 - few) {
            icp->warnings |= REG_WARN_MIXED_NORMALS;
            reg_cloud_free(&side->own);
            return regi_icp_fit_normals(icp, shape, side);
        }
    } else {
        side->unsure = 1;
    }
    if (side->sign < 0)
        icp->warnings |= REG_WARN_INVERTED;
    return regi_icp_smooth_normals(icp, side);
}

/* Centre, size and principal axes of the evenly spread points. An axis has no direction of its own: it gets the one in
 * which the points reach farther (the sign of the third moment), so that the axes turn with the shape. */
static void regi_icp_principal_axes(regi_icp_side *side)
{
    const regi_icp_set *set = &side->spread;
    sb_mat3 spread = sb_m3_zero();
    sb_vec3 skew = sb_v3(0, 0, 0), axis[3];
    side->centre = sb_v3(0, 0, 0);
    for (int i = 0; i < set->count; i++)
        side->centre = sb_v3_madd(side->centre, 1 / (sb_real)(i + 1), sb_v3_sub(set->points[i], side->centre));
    for (int i = 0; i < set->count; i++) {
        sb_vec3 d = sb_v3_sub(set->points[i], side->centre);
        spread = sb_m3_add(spread, sb_m3_outer(sb_v3_scale(1 / (sb_real)set->count, d), d));
    }
    side->size = sb_sqrt(sb_max(sb_m3_trace(spread), 0));
    sb_m3_eigen(spread, NULL, &side->axes);
    for (int i = 0; i < set->count && side->size > 0; i++) {
        sb_vec3 d = sb_m3_tapply(side->axes, sb_v3_scale(1 / side->size, sb_v3_sub(set->points[i], side->centre)));
        skew = sb_v3_add(skew, sb_v3(d.x * d.x * d.x, d.y * d.y * d.y, d.z * d.z * d.z));
    }
    axis[0] = sb_v3_scale(skew.x < 0 ? -1 : 1, sb_m3_column(side->axes, 0));
    axis[1] = sb_v3_scale(skew.y < 0 ? -1 : 1, sb_m3_column(side->axes, 1));
    axis[2] = sb_v3_cross(axis[0], axis[1]);
    side->axes = sb_m3_columns(axis[0], axis[1], axis[2]);
}

/* Extent, area and spacing. Evenly spread points have a neighbour at d in every 0.75 d^2 or so of their surface. */
static void regi_icp_measure_side(regi_icp_side *side)
{
    const regi_icp_set *set = &side->spread;
    sb_vec3 low = set->points[0], high = low;
    int pair[2];
    sb_real squared[2], share;
    side->area = 0;
    for (int i = 0; i < set->count; i++) {
        sb_vec3 p = set->points[i];
        low = sb_v3(sb_min(low.x, p.x), sb_min(low.y, p.y), sb_min(low.z, p.z));
        high = sb_v3(sb_max(high.x, p.x), sb_max(high.y, p.y), sb_max(high.z, p.z));
        if (reg_kdtree_k_nearest(side->spread_tree, p, 2, pair, squared) == 2)
            side->area += (sb_real)0.75 * squared[1];
    }
    side->extent = sb_v3_norm(sb_v3_sub(high, low));
    share = side->area / (sb_real)side->count;
    side->spacing = sb_sqrt(sb_max(share, 0));
}

REGI_API reg_rigid regi_icp_of_model(const regi_icp *icp, const reg_rigid *motion)
{
    return icp->swapped ? reg_rigid_inverse(motion) : *motion;
}

REGI_API sb_vec3 regi_icp_facing(const regi_icp_set *set)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int i = 0; i < set->count; i++)
        sum = sb_v3_add(sum, set->normals[i]);
    return sb_v3_scale(1 / (sb_real)set->count, sum);
}

static sb_result regi_icp_usual_sd(const regi_icp *icp, regi_icp_side *side)
{
    sb_real *scratch;
    side->usual_sd = 1;
    if (!side->sd)
        return SB_OK;
    scratch = (sb_real *)sbi_alloc(icp->allocator, (size_t)side->count, sizeof(sb_real));
    if (!scratch)
        return regi_icp_no_memory(icp);
    side->usual_sd = reg_outlier_limit(side->sd, side->count, REG_OUTLIERS_TRIM, (sb_real)0.5, scratch);
    sbi_free(icp->allocator, scratch);
    return SB_OK;
}

REGI_API sb_result regi_icp_side_make(regi_icp *icp, const reg_icp_shape *shape, regi_icp_side *side)
{
    sb_result result = SB_OK;
    side->points = shape->points;
    side->normals = shape->normals;
    side->weights = shape->weights;
    side->sd = shape->sd;
    side->count = shape->count;
    side->surface = shape->surface;
    side->tree = shape->tree;
    if (!side->tree) {
        result = reg_kdtree_create(shape->points, shape->count, icp->allocator, &side->own_tree, icp->error);
        side->tree = side->own_tree;
    }
    if (result == SB_OK)
        result = regi_icp_usual_sd(icp, side);
    if (result == SB_OK)
        result = regi_icp_normals(icp, shape, side);
    if (result == SB_OK)
        result =
            regi_icp_sample(icp, side, icp->options->sample > 0 ? icp->options->sample : side->count, &side->sample);
    if (result == SB_OK)
        result = regi_icp_spread(icp, side, &side->spread);
    if (result == SB_OK)
        result =
            reg_kdtree_create(side->spread.points, side->spread.count, icp->allocator, &side->spread_tree, icp->error);
    if (result == SB_OK) {
        regi_icp_principal_axes(side);
        regi_icp_measure_side(side);
    }
    return result;
}
