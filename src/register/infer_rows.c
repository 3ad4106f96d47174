/* infer_rows: the target's points, their patches, places of the model, and trust. */
#include "infer_private.h"

#include <string.h>

#include "cloud.h"

REGI_API double regi_infer_now(const reg_infer *infer) { return infer->def->clock ? infer->def->clock() : 0.0; }

/* ---- patches ---- */

/* Centres spread evenly over the points, each point to the closest; points are sorted by patch, else as they were. */
static sb_result regi_infer_cut(reg_infer *f, int patches, sb_vec3 *at, int *chosen, int *count, sb_error *error)
{
    reg_kdtree *tree = NULL;
    sb_result result;
    for (int i = 0; i < f->point_count; i++)
        at[i] = f->points[i].at;
    f->patch_count = reg_cloud_spread(at, f->point_count, patches, chosen, f->sort);
    for (int s = 0; s < f->patch_count; s++)
        at[s] = f->points[chosen[s]].at;
    result = reg_kdtree_create(at, f->patch_count, &f->allocator, &tree, error);
    if (result != SB_OK)
        return result;
    memset(count, 0, (size_t)(f->patch_count + 1) * sizeof *count);
    for (int i = 0; i < f->point_count; i++) {
        f->points[i].patch = reg_kdtree_nearest(tree, f->points[i].at, SB_REAL_MAX, NULL);
        f->points[i].patch = f->points[i].patch < 0 ? 0 : f->points[i].patch; /* too far away for squares */
        count[f->points[i].patch + 1]++;
    }
    reg_kdtree_destroy(tree);
    return SB_OK;
}

REGI_API sb_result regi_infer_group(reg_infer *f, int patches, sb_error *error)
{
    size_t n = (size_t)f->point_count;
    regi_infer_point *sorted = (regi_infer_point *)sbi_alloc(&f->allocator, n, sizeof *sorted);
    sb_vec3 *at = (sb_vec3 *)sbi_alloc(&f->allocator, n, sizeof *at);
    int *chosen = (int *)sbi_alloc(&f->allocator, (size_t)patches, sizeof *chosen);
    sb_result result = SB_OK;
    if (!sorted || !at || !chosen)
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the patches of %d points", f->point_count);
    if (result == SB_OK)
        result = regi_infer_cut(f, patches, at, chosen, f->patch_start, error);
    if (result == SB_OK) {
        for (int s = 0; s < f->patch_count; s++)
            f->patch_start[s + 1] += f->patch_start[s];
        for (int i = 0; i < f->point_count; i++)
            sorted[f->patch_start[f->points[i].patch]++] = f->points[i];
        memmove(f->patch_start + 1, f->patch_start, (size_t)f->patch_count * sizeof(int));
        f->patch_start[0] = 0;
        memcpy(f->points, sorted, n * sizeof *sorted);
    }
    sbi_free(&f->allocator, chosen);
    sbi_free(&f->allocator, at);
    sbi_free(&f->allocator, sorted);
    return result;
}

/* ---- places ---- */

/* 1 when the model's place of a point may be what was seen. */
static int regi_infer_is_allowed(const reg_infer *f, const regi_infer_point *p)
{
    sb_vec3 way = sb_v3_sub(p->at, p->place), view;
    sb_real most = (sb_real)0.02 * f->model->size;
    if (!(p->weight > 0) || sb_v3_dot(p->normal, p->plane) < 0)
        return 0;
    if (sb_v3_norm(sb_v3_sub(way, sb_v3_scale(p->gap, p->plane))) > most)
        return 0;
    if (!f->def->target.has_camera)
        return 1;
    view = sb_v3_sub(f->def->target.camera, p->place);
    return sb_v3_dot(view, p->plane) > (sb_real)-0.1 * sb_v3_norm(view);
}

static void regi_infer_place(reg_infer *f, regi_infer_point *p)
{
    sb_surface_hit hit;
    p->trust = 0;
    p->gap = 0;
    if (!sb_surface_closest_from(f->model->tree, p->at, SB_REAL_MAX, p->triangle, &hit)) {
        p->triangle = -1;
        return;
    }
    p->triangle = hit.triangle;
    for (int k = 0; k < 3; k++)
        p->corner[k] = hit.weights[k];
    p->place = hit.point;
    p->plane = sb_surface_normal(f->model->tree, &hit);
    p->gap = sb_v3_dot(p->plane, sb_v3_sub(p->at, p->place));
    p->trust = regi_infer_is_allowed(f, p) ? p->weight : 0;
}

/* Median of what is in sort[count]; 0 for none. */
static sb_real regi_infer_median(reg_infer *f, int count)
{
    return count > 0 ? regi_cloud_select(f->sort, count, (count - 1) / 2) : 0;
}

/* Median gap of a patch's allowed points. */
static sb_real regi_infer_patch_median(reg_infer *f, int patch)
{
    int count = 0;
    for (int i = f->patch_start[patch]; i < f->patch_start[patch + 1]; i++)
        if (f->points[i].trust > 0)
            f->sort[count++] = f->points[i].gap;
    return regi_infer_median(f, count);
}

/* Noise of the points: 1.48 times the median of their deviations from the medians of their patches, which are left in
 * `off`. A single point has none, so that patches of two or three are counted for what they are worth. */
static void regi_infer_estimate_noise(reg_infer *f)
{
    int count = 0;
    for (int s = 0; s < f->patch_count; s++) {
        sb_real median = regi_infer_patch_median(f, s);
        for (int i = f->patch_start[s]; i < f->patch_start[s + 1]; i++)
            f->points[i].off = f->points[i].gap - median;
    }
    for (int s = 0; s < f->patch_count; s++)
        for (int i = f->patch_start[s]; i < f->patch_start[s + 1]; i++)
            if (f->points[i].trust > 0 && f->patch_start[s + 1] - f->patch_start[s] > 1)
                f->sort[count++] = sb_abs(f->points[i].off);
    f->noise = (sb_real)1.4826 * regi_infer_median(f, count);
}

/* Less trust in what is far off: in all the target, and in its patch. The limit begins with what loads may well do, and
 * halves each round, down to what the others scatter, but no farther than to what a coarse model may be off by: a dent
 * is followed before what is left is taken for no organ. */
static void regi_infer_weigh_points(reg_infer *f, int round)
{
    int count = 0;
    sb_real limit, early = (sb_real)0.08 * f->model->size;
    for (int k = 0; k < round; k++)
        early *= (sb_real)0.5;
    for (int i = 0; i < f->point_count; i++)
        if (f->points[i].trust > 0)
            f->sort[count++] = sb_abs(f->points[i].gap);
    limit = sb_max(sb_max(early, (sb_real)0.01 * f->model->size),
                   (sb_real)(round < 2 ? 4 : 6) * regi_infer_median(f, count) + 3 * f->noise);
    for (int i = 0; i < f->point_count && limit > 0; i++) {
        regi_infer_point *p = f->points + i;
        sb_real far = p->gap / limit, off = p->off / sb_max(3 * f->noise, (sb_real)0.3 * limit);
        p->trust /= (1 + far * far) * (1 + far * far) * (1 + off * off);
    }
}

/* ---- data ---- */

/* Shares of a patch's points in its row, and the variance of their mean: of noise, of which three neighbours count as
 * one, and of a share of what the patch is steeper than noise, as at the rim of a dent: that does not average out. */
static double regi_infer_share_patch(reg_infer *f, int patch)
{
    const double steep = 0.09;
    double sum = 0, squares = 0, most = 0, spread = 0;
    for (int i = f->patch_start[patch]; i < f->patch_start[patch + 1]; i++) {
        regi_infer_point *p = f->points + i;
        p->share = p->sd > 0 ? p->trust / (p->sd * p->sd) : p->trust;
        sum += (double)p->share;
    }
    for (int i = f->patch_start[patch]; i < f->patch_start[patch + 1]; i++) {
        regi_infer_point *p = f->points + i;
        double sd = (double)(p->sd > 0 ? p->sd : f->noise);
        p->share = (sb_real)((double)p->share / sum);
        squares += (double)p->share * (double)p->share * sd * sd;
        most += (double)p->share * sd * sd;
        spread += (double)p->share * ((double)p->off * (double)p->off - sd * sd);
    }
    return (3 * squares < most ? 3 * squares : most) + (spread > 0 ? steep * spread : 0);
}

/* Share of its given weight that a patch keeps. */
static sb_real regi_infer_patch_trust(const reg_infer *f, int patch)
{
    double kept = 0, all = 0;
    for (int i = f->patch_start[patch]; i < f->patch_start[patch + 1]; i++) {
        kept += (double)f->points[i].trust;
        all += (double)f->points[i].weight;
    }
    return all > 0 ? (sb_real)(kept / all) : 0;
}

static int regi_infer_list_data(reg_infer *f)
{
    int count = 0, patches;
    sb_real least;
    for (int s = 0; s < f->patch_count; s++) {
        sb_real trust = regi_infer_patch_trust(f, s);
        if (trust > 0)
            f->sort[count++] = trust;
    }
    least = (sb_real)0.3 * regi_infer_median(f, count);
    f->gauss.count = 0;
    for (int s = 0; s < f->patch_count; s++)
        if (regi_infer_patch_trust(f, s) > least) {
            f->averaged[f->gauss.count] = regi_infer_share_patch(f, s);
            f->patch_of[f->gauss.count++] = s;
        }
    patches = f->gauss.count;
    for (int k = 0; k < 3 * f->landmark_count; k++) {
        f->averaged[f->gauss.count] = (double)f->mark_sd[k / 3] * (double)f->mark_sd[k / 3];
        f->patch_of[f->gauss.count++] = -1 - k;
    }
    return patches;
}

REGI_API int regi_infer_look(reg_infer *f, int round)
{
    const reg_model *m = f->model;
    sb_mapping_apply(&m->rows.mapping, sb_body_positions(m->body), f->skin);
    if (sb_surface_move(m->tree, f->skin, &m->jobs, NULL) != SB_OK)
        return 0;
    for (int i = 0; i < f->point_count; i++)
        regi_infer_place(f, f->points + i);
    regi_infer_estimate_noise(f);
    regi_infer_weigh_points(f, round);
    return regi_infer_list_data(f);
}

/* ---- rows ---- */

/* Adds line, shared out by one row of a mapping. */
static void regi_infer_add(const sb_mapping *mapping, int point, sb_vec3 line, sb_vec3 *row)
{
    for (int k = mapping->row_start[point]; k < mapping->row_start[point + 1]; k++)
        row[mapping->nodes[k]] = sb_v3_madd(row[mapping->nodes[k]], mapping->weights[k], line);
}

static void regi_infer_add_pose(const reg_infer *f, sb_vec3 place, sb_vec3 line, double pose[REGI_INFER_POSE])
{
    sb_vec3 turn = sb_v3_cross(sb_v3_sub(place, f->centre), line);
    const sb_real slope[REGI_INFER_POSE] = {line.x, line.y, line.z, turn.x, turn.y, turn.z};
    for (int k = 0; k < REGI_INFER_POSE; k++)
        pose[k] += (double)slope[k];
}

static void regi_infer_mark_row(const reg_infer *f, int component, sb_vec3 *row, double *gap,
                                double pose[REGI_INFER_POSE])
{
    int mark = component / 3, axis = component % 3;
    sb_vec3 line = sb_v3(axis == 0, axis == 1, axis == 2), now = sb_v3(0, 0, 0);
    const sb_mapping *mapping = &f->marks.mapping;
    for (int k = mapping->row_start[mark]; k < mapping->row_start[mark + 1]; k++)
        now = sb_v3_madd(now, mapping->weights[k], sb_body_positions(f->model->body)[mapping->nodes[k]]);
    *gap = (double)sb_v3_dot(sb_v3_sub(f->mark_seen[mark], now), line);
    regi_infer_add_pose(f, now, line, pose);
    regi_infer_add(mapping, mark, line, row);
}

REGI_API void regi_infer_row(const reg_infer *f, int datum, sb_vec3 *row, double *gap, double pose[REGI_INFER_POSE])
{
    int patch = f->patch_of[datum];
    *gap = 0;
    memset(pose, 0, REGI_INFER_POSE * sizeof *pose);
    if (patch < 0) {
        regi_infer_mark_row(f, -1 - patch, row, gap, pose);
        return;
    }
    for (int i = f->patch_start[patch]; i < f->patch_start[patch + 1]; i++) {
        const regi_infer_point *p = f->points + i;
        const int *corners = p->triangle < 0 ? NULL : f->model->skin.elements + 3 * (size_t)p->triangle;
        sb_vec3 line = sb_v3_scale(p->share, p->plane);
        if (!(p->share > 0) || !corners)
            continue;
        *gap += (double)(p->share * p->gap);
        regi_infer_add_pose(f, p->place, line, pose);
        for (int k = 0; k < 3; k++)
            regi_infer_add(&f->model->rows.mapping, corners[k], sb_v3_scale(p->corner[k], line), row);
    }
}

static double regi_infer_measure_point(const sb_mapping *mapping, int point, sb_vec3 line, const sb_vec3 *u)
{
    sb_real sum = 0;
    for (int k = mapping->row_start[point]; k < mapping->row_start[point + 1]; k++)
        sum += mapping->weights[k] * sb_v3_dot(line, u[mapping->nodes[k]]);
    return (double)sum;
}

REGI_API double regi_infer_measure(const reg_infer *f, int datum, const sb_vec3 *u)
{
    int patch = f->patch_of[datum];
    double sum = 0;
    if (patch < 0) {
        int axis = (-1 - patch) % 3;
        return regi_infer_measure_point(&f->marks.mapping, (-1 - patch) / 3, sb_v3(axis == 0, axis == 1, axis == 2), u);
    }
    for (int i = f->patch_start[patch]; i < f->patch_start[patch + 1]; i++) {
        const regi_infer_point *p = f->points + i;
        for (int k = 0; k < 3 && p->share > 0 && p->triangle >= 0; k++)
            sum += regi_infer_measure_point(&f->model->rows.mapping,
                                            f->model->skin.elements[3 * (size_t)p->triangle + (size_t)k],
                                            sb_v3_scale(p->share * p->corner[k], p->plane), u);
    }
    return sum;
}
