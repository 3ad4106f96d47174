/* infer_rows: the target's points, their patches, places of the model, and trust. */
#include "infer_private.h"

#include <string.h>

#include "cloud.h"

REGI_API double regi_infer_now(const reg_infer *infer) { return infer->def->clock ? infer->def->clock() : 0.0; }

/* ---- patches ---- */

/* Centres spread evenly over the points, each point to the closest. at: the centres, then. */
static sb_result regi_infer_cut(reg_infer *f, int patches, sb_vec3 *at, int *chosen, int *count, sb_error *error)
{
    reg_kdtree *tree = NULL;
    sb_result result;
    for (int i = 0; i < f->look.point_count; i++)
        at[i] = f->look.points[i].at;
    f->look.patch_count = reg_cloud_spread(at, f->look.point_count, patches, chosen, f->look.sort);
    for (int s = 0; s < f->look.patch_count; s++)
        at[s] = f->look.points[chosen[s]].at;
    result = reg_kdtree_create(at, f->look.patch_count, &f->allocator, &tree, error);
    if (result != SB_OK)
        return result;
    memset(count, 0, (size_t)(f->look.patch_count + 1) * sizeof *count);
    for (int i = 0; i < f->look.point_count; i++) {
        f->look.points[i].patch = reg_kdtree_nearest(tree, f->look.points[i].at, SB_REAL_MAX, NULL);
        f->look.points[i].patch =
            f->look.points[i].patch < 0 ? 0 : f->look.points[i].patch; /* too far away for squares */
        count[f->look.points[i].patch + 1]++;
    }
    reg_kdtree_destroy(tree);
    return SB_OK;
}

/* A patch's centre is the first of its points, whatever order they came in. */
static void regi_infer_put_centres_first(reg_infer *f, const sb_vec3 *at)
{
    for (int s = 0; s < f->look.patch_count; s++) {
        regi_look_point *first = f->look.points + f->look.patch_start[s], centre;
        for (int i = f->look.patch_start[s]; i < f->look.patch_start[s + 1]; i++) {
            sb_vec3 off = sb_v3_sub(f->look.points[i].at, at[s]);
            if (sb_v3_dot(off, off) > 0)
                continue;
            centre = f->look.points[i];
            f->look.points[i] = *first;
            *first = centre;
            break;
        }
    }
}

/* Points sorted by patch. */
REGI_API sb_result regi_infer_group(reg_infer *f, int patches, sb_error *error)
{
    size_t n = (size_t)f->look.point_count;
    regi_look_point *sorted = (regi_look_point *)sbi_alloc(&f->allocator, n, sizeof *sorted);
    sb_vec3 *at = (sb_vec3 *)sbi_alloc(&f->allocator, n, sizeof *at);
    int *chosen = (int *)sbi_alloc(&f->allocator, (size_t)patches, sizeof *chosen);
    sb_result result = SB_OK;
    if (!sorted || !at || !chosen)
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the patches of %d points", f->look.point_count);
    if (result == SB_OK)
        result = regi_infer_cut(f, patches, at, chosen, f->look.patch_start, error);
    if (result == SB_OK) {
        for (int s = 0; s < f->look.patch_count; s++)
            f->look.patch_start[s + 1] += f->look.patch_start[s];
        for (int i = 0; i < f->look.point_count; i++)
            sorted[f->look.patch_start[f->look.points[i].patch]++] = f->look.points[i];
        memmove(f->look.patch_start + 1, f->look.patch_start, (size_t)f->look.patch_count * sizeof(int));
        f->look.patch_start[0] = 0;
        memcpy(f->look.points, sorted, n * sizeof *sorted);
        regi_infer_put_centres_first(f, at);
    }
    sbi_free(&f->allocator, chosen);
    sbi_free(&f->allocator, at);
    sbi_free(&f->allocator, sorted);
    return result;
}

REGI_API sb_real regi_infer_spacing(const reg_infer *f)
{
    double sum = 0;
    int count = 0;
    for (int s = 0; s < f->look.patch_count; s++) {
        sb_real nearest = SB_REAL_MAX;
        for (int t = 0; t < f->look.patch_count; t++) {
            sb_vec3 d = sb_v3_sub(f->look.points[f->look.patch_start[s]].at, f->look.points[f->look.patch_start[t]].at);
            nearest = t == s ? nearest : sb_min(nearest, sb_v3_dot(d, d));
        }
        sum += nearest < SB_REAL_MAX ? (double)sb_sqrt(nearest) : 0;
        count++;
    }
    return count > 0 ? (sb_real)(sum / count) : 0;
}

/* ---- data ---- */

static int regi_infer_list_data(reg_infer *f)
{
    int patches;
    sb_real least = regi_look_least_trust(&f->look);
    f->gauss.count = 0;
    for (int s = 0; s < f->look.patch_count; s++)
        if (regi_look_patch_trust(&f->look, s) > least) {
            f->averaged[f->gauss.count] = regi_look_share_patch(&f->look, s);
            f->patch_of[f->gauss.count++] = s;
        }
    patches = f->gauss.count;
    for (int k = 0; k < f->marks.line_count; k++) {
        f->averaged[f->gauss.count] = f->marks.lines[k].variance;
        f->patch_of[f->gauss.count++] = -1 - k;
    }
    return patches;
}

/* The limit of what is believed begins with what loads may well do, and halves each round, down to what the others
 * scatter, but no farther than to what a coarse model may be off by: a dent is followed before what is left is taken
 * for no organ. */
static sb_real regi_infer_early_limit(const reg_infer *f, int round)
{
    sb_real early = (sb_real)0.08 * f->model->size;
    for (int k = 0; k < round; k++)
        early *= (sb_real)0.5;
    return sb_max(early, (sb_real)0.01 * f->model->size);
}

REGI_API int regi_infer_look(reg_infer *f, int round)
{
    const reg_model *m = f->model;
    sb_mapping_apply(&m->rows.mapping, sb_body_positions(m->body), f->skin);
    if (sb_surface_move(m->tree, f->skin, &m->jobs, NULL) != SB_OK)
        return 0;
    for (int i = 0; i < f->look.point_count; i++)
        regi_look_place(&f->look, f->look.points + i);
    regi_look_judge(&f->look, regi_infer_early_limit(f, round), round < 2 ? 4 : 6);
    if (f->marks.sample_count > 0)
        sb_mapping_apply(&f->marks.rows.mapping, sb_body_positions(m->body), f->marks.places);
    regi_marks_follow(&f->marks);
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
    sb_vec3 turn = sb_v3_cross(sb_v3_sub(place, f->response.centre), line);
    const sb_real slope[REGI_INFER_POSE] = {line.x, line.y, line.z, turn.x, turn.y, turn.z};
    for (int k = 0; k < REGI_INFER_POSE; k++)
        pose[k] += (double)slope[k];
}

/* Adds a line's row to row[nodes], and tells its gap and the place that it is of (m). */
static void regi_infer_add_line(const reg_infer *f, const regi_marks_line *line, sb_vec3 *row, double *gap,
                                sb_vec3 *place)
{
    const sb_mapping *mapping = &f->marks.rows.mapping;
    const sb_vec3 *x = sb_body_positions(f->model->body);
    *place = sb_v3(0, 0, 0);
    for (int end = 0; end < 2; end++) {
        sb_real part = end ? line->share : 1 - line->share;
        for (int k = mapping->row_start[line->points[end]]; k < mapping->row_start[line->points[end] + 1]; k++) {
            int node = mapping->nodes[k];
            *place = sb_v3_madd(*place, part * mapping->weights[k], x[node]);
            row[node] = sb_v3_madd(row[node], part * mapping->weights[k], line->axis);
        }
    }
    *gap = (double)sb_v3_dot(sb_v3_sub(line->seen, *place), line->axis);
}

REGI_API void regi_infer_row(const reg_infer *f, int datum, sb_vec3 *row, double *gap, double pose[REGI_INFER_POSE])
{
    int patch = f->patch_of[datum];
    *gap = 0;
    memset(pose, 0, REGI_INFER_POSE * sizeof *pose);
    if (patch < 0) {
        const regi_marks_line *line = f->marks.lines + (-1 - patch);
        sb_vec3 place;
        regi_infer_add_line(f, line, row, gap, &place);
        regi_infer_add_pose(f, place, line->axis, pose);
        return;
    }
    for (int i = f->look.patch_start[patch]; i < f->look.patch_start[patch + 1]; i++) {
        const regi_look_point *p = f->look.points + i;
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
        const regi_marks_line *line = f->marks.lines + (-1 - patch);
        return (double)(1 - line->share) *
                   regi_infer_measure_point(&f->marks.rows.mapping, line->points[0], line->axis, u) +
               (double)line->share * regi_infer_measure_point(&f->marks.rows.mapping, line->points[1], line->axis, u);
    }
    for (int i = f->look.patch_start[patch]; i < f->look.patch_start[patch + 1]; i++) {
        const regi_look_point *p = f->look.points + i;
        for (int k = 0; k < 3 && p->share > 0 && p->triangle >= 0; k++)
            sum += regi_infer_measure_point(&f->model->rows.mapping,
                                            f->model->skin.elements[3 * (size_t)p->triangle + (size_t)k],
                                            sb_v3_scale(p->share * p->corner[k], p->plane), u);
    }
    return sum;
}
