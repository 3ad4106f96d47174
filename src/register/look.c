/* look: see look.h. */
#include "look.h"

#include <string.h>

#include "cloud.h"

REGI_API void regi_look_take(regi_look_point *p, sb_vec3 at, sb_vec3 normal, sb_real weight, sb_real sd)
{
    memset(p, 0, sizeof *p);
    p->at = at;
    p->normal = regi_cloud_unit(normal);
    p->weight = weight;
    p->sd = sd;
    p->triangle = -1;
}

/* ---- places ---- */

/* 1 when the model's place of a point may be what was seen. */
static int regi_look_is_allowed(const regi_look *look, const regi_look_point *p)
{
    sb_vec3 way = sb_v3_sub(p->at, p->place), view;
    sb_real most = (sb_real)0.02 * look->size;
    if (!(p->weight > 0) || sb_v3_dot(p->normal, p->plane) < 0)
        return 0;
    if (sb_v3_norm(sb_v3_sub(way, sb_v3_scale(p->gap, p->plane))) > most)
        return 0;
    if (!look->has_camera)
        return 1;
    view = sb_v3_sub(look->camera, p->place);
    return sb_v3_dot(view, p->plane) > (sb_real)-0.1 * sb_v3_norm(view);
}

REGI_API void regi_look_place(const regi_look *look, regi_look_point *p)
{
    sb_surface_hit hit;
    p->trust = 0;
    p->gap = 0;
    if (!sb_surface_closest_from(look->tree, p->at, SB_REAL_MAX, p->triangle, &hit)) {
        p->triangle = -1;
        return;
    }
    p->triangle = hit.triangle;
    for (int k = 0; k < 3; k++)
        p->corner[k] = hit.weights[k];
    p->place = hit.point;
    p->plane = sb_surface_normal(look->tree, &hit);
    p->gap = sb_v3_dot(p->plane, sb_v3_sub(p->at, p->place));
    p->trust = regi_look_is_allowed(look, p) ? p->weight : 0;
}

/* Median of what is in sort[count]; 0 for none. */
static sb_real regi_look_median(regi_look *look, int count)
{
    return count > 0 ? regi_cloud_select(look->sort, count, (count - 1) / 2) : 0;
}

/* Median gap of a patch's allowed points. */
static sb_real regi_look_patch_median(regi_look *look, int patch)
{
    int count = 0;
    for (int i = look->patch_start[patch]; i < look->patch_start[patch + 1]; i++)
        if (look->points[i].trust > 0)
            look->sort[count++] = look->points[i].gap;
    return regi_look_median(look, count);
}

/* Noise of the points: 1.48 times the median of their deviations from the medians of their patches, which are left in
 * `off`. A single point has none, so that patches of two or three are counted for what they are worth. */
static void regi_look_estimate_noise(regi_look *look)
{
    int count = 0;
    for (int s = 0; s < look->patch_count; s++) {
        sb_real median = regi_look_patch_median(look, s);
        for (int i = look->patch_start[s]; i < look->patch_start[s + 1]; i++)
            look->points[i].off = look->points[i].gap - median;
    }
    for (int s = 0; s < look->patch_count; s++)
        for (int i = look->patch_start[s]; i < look->patch_start[s + 1]; i++)
            if (look->points[i].trust > 0 && look->patch_start[s + 1] - look->patch_start[s] > 1)
                look->sort[count++] = sb_abs(look->points[i].off);
    look->noise = (sb_real)1.4826 * regi_look_median(look, count);
}

/* Less trust in what is far off. */
static void regi_look_weigh_points(regi_look *look, sb_real early, sb_real medians)
{
    int count = 0;
    sb_real limit;
    for (int i = 0; i < look->point_count; i++)
        if (look->points[i].trust > 0)
            look->sort[count++] = sb_abs(look->points[i].gap);
    limit = sb_max(early, medians * regi_look_median(look, count) + 3 * look->noise);
    for (int i = 0; i < look->point_count && limit > 0; i++) {
        regi_look_point *p = look->points + i;
        sb_real far = p->gap / limit, off = p->off / sb_max(3 * look->noise, (sb_real)0.3 * limit);
        p->trust /= (1 + far * far) * (1 + far * far) * (1 + off * off);
    }
}

REGI_API void regi_look_judge(regi_look *look, sb_real early, sb_real medians)
{
    regi_look_estimate_noise(look);
    regi_look_weigh_points(look, early, medians);
}

/* ---- patches ---- */

/* Shares of a patch's points in its row, and the variance of their mean: of noise, of which three neighbours count as
 * one, and of a share of what the patch is steeper than noise, as at the rim of a dent: that does not average out. */
REGI_API double regi_look_share_patch(regi_look *look, int patch)
{
    const double steep = 0.09;
    double sum = 0, squares = 0, most = 0, spread = 0;
    for (int i = look->patch_start[patch]; i < look->patch_start[patch + 1]; i++) {
        regi_look_point *p = look->points + i;
        p->share = p->sd > 0 ? p->trust / (p->sd * p->sd) : p->trust;
        sum += (double)p->share;
    }
    for (int i = look->patch_start[patch]; i < look->patch_start[patch + 1]; i++) {
        regi_look_point *p = look->points + i;
        double sd = (double)(p->sd > 0 ? p->sd : look->noise);
        p->share = (sb_real)((double)p->share / sum);
        squares += (double)p->share * (double)p->share * sd * sd;
        most += (double)p->share * sd * sd;
        spread += (double)p->share * ((double)p->off * (double)p->off - sd * sd);
    }
    return (3 * squares < most ? 3 * squares : most) + (spread > 0 ? steep * spread : 0);
}

/* Share of its given weight that a patch keeps. */
REGI_API sb_real regi_look_patch_trust(const regi_look *look, int patch)
{
    double kept = 0, all = 0;
    for (int i = look->patch_start[patch]; i < look->patch_start[patch + 1]; i++) {
        kept += (double)look->points[i].trust;
        all += (double)look->points[i].weight;
    }
    return all > 0 ? (sb_real)(kept / all) : 0;
}

REGI_API sb_real regi_look_least_trust(regi_look *look)
{
    int count = 0;
    for (int s = 0; s < look->patch_count; s++) {
        sb_real trust = regi_look_patch_trust(look, s);
        if (trust > 0)
            look->sort[count++] = trust;
    }
    return (sb_real)0.3 * regi_look_median(look, count);
}

/* ---- fit ---- */

REGI_API void regi_look_measure(regi_look *look, sb_real *used, sb_real *residual, sb_real *residual_p95)
{
    double believed = 0, all = 0, sum = 0;
    int count = 0;
    for (int i = 0; i < look->point_count; i++) {
        const regi_look_point *p = look->points + i;
        int good = p->trust > (sb_real)0.25 * p->weight;
        all += (double)p->weight;
        if (!good)
            continue;
        believed += (double)p->weight;
        sum += (double)sb_abs(p->gap);
        look->sort[count++] = sb_abs(p->gap);
    }
    *used = (sb_real)(all > 0 ? believed / all : 0);
    *residual = (sb_real)(count > 0 ? sum / count : 0);
    *residual_p95 = count > 0 ? regi_cloud_select(look->sort, count, (int)(0.95 * (count - 1))) : 0;
}
