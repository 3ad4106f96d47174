/* cut_along: cuts along triangles. */
#include "cut_private.h"

#include <string.h>

SBI_API sbi_cut_box sbi_cut_box_of(const sb_cut *cut, const sb_vec3 *x, int part)
{
    const sbi_slots *nodes = &cut->body->live->nodes;
    sbi_cut_box box = {{0, 0, 0}, {0, 0, 0}};
    int i = 0;
    while (i < nodes->end && (!nodes->used[i] || !sbi_cut_is_of(cut, i, part)))
        i++;
    if (i < nodes->end)
        box.low = box.high = x[i];
    for (; i < nodes->end; i++)
        if (nodes->used[i] && sbi_cut_is_of(cut, i, part))
            sbi_cut_box_add(&box, x[i]);
    return box;
}

SBI_API double sbi_cut_size_of(const sbi_cut_box *box) { return (double)sb_v3_norm(sb_v3_sub(box->high, box->low)); }

SBI_API sb_result sbi_cut_check_use(const sb_cut *cut, sb_error *error)
{
    if (!cut->body)
        return sbi_fail(error, SB_ERROR_STATE, "the body is gone");
    if (cut->stale)
        return sbi_fail(error, SB_ERROR_STATE, "the body's mesh was changed by others: make a new sb_cut");
    return SB_OK;
}

static sb_result sbi_cut_check_call(const sb_cut *cut, const sb_vec3 *triangles, int count, sb_error *error)
{
    sb_result result;
    if (!cut || count < 0 || (count > 0 && !triangles))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_cut_triangles needs a cut, triangles and their count");
    result = sbi_cut_check_use(cut, error);
    for (int k = 0; k < count && result == SB_OK; k++)
        for (int a = 0; a < 3; a++)
            if (!sb_v3_is_finite(triangles[3 * (size_t)k + (size_t)a]))
                return sbi_fail(error, SB_ERROR_NOT_FINITE, "corner %d of triangle %d is not finite", a, k);
    return result;
}

/* How many times as large as at rest a body may be for one frame to resolve all of it. */
#define SBI_CUT_SPREAD 8.0

static int sbi_cut_take_blades(sb_cut *cut, const sbi_crossing_frame *frame, const sb_vec3 *triangles, int count)
{
    cut->blade_count = 0;
    for (int k = 0; k < count; k++) {
        if (!sbi_cut_reserve_blades(cut, SBI_CROSSING_PARTS))
            return 0;
        cut->blade_count += sbi_crossing_blades(frame, triangles + 3 * (size_t)k, cut->blades + cut->blade_count);
    }
    sbi_blade_tree_make(&cut->tree, cut->blades, cut->blade_count, cut->blade_codes, cut->blade_scratch);
    return 1;
}

/* Work on a part, or on all parts, in a frame that blades are of; 0: no memory. */
typedef int sbi_cut_frame_work(sb_cut *cut, const sbi_crossing_frame *frame, int part);

/* Cuts links, and predicts some. */
static int sbi_cut_sweep_part(sb_cut *cut, const sbi_crossing_frame *frame, int part)
{
    int done = sbi_cut_sweep(cut, frame, part);
    if (done && cut->glues)
        done = sbi_cut_predict(cut, frame, part);
    if (done)
        sbi_cut_forget_struck(cut); /* the next frame has other blades */
    return done;
}

/* Does it in a frame about what lies in the box. */
static int sbi_cut_in_box(sb_cut *cut, const sbi_cut_box *box, int part, const sb_vec3 *triangles, int count,
                          sbi_cut_frame_work *work)
{
    sbi_crossing_frame frame;
    sbi_crossing_frame_make(box->low, box->high, &frame);
    return sbi_cut_take_blades(cut, &frame, triangles, count) && work(cut, &frame, part);
}

SBI_API void sbi_cut_list_reached(sb_cut *cut, const sb_vec3 *points, int count, sb_real margin)
{
    const double rounding = 1.0 / (1 << 14); /* of the body's size: more than places are rounded by */
    sbi_cut_box now = sbi_cut_box_of(cut, sb_body_positions(cut->body), SBI_CUT_ALL_PARTS);
    sbi_cut_box reach = sbi_cut_box_around(points, count);
    sb_real rounded = (sb_real)(rounding * sbi_cut_size_of(&now));
    cut->now = now;
    cut->reach = reach;
    sbi_cut_box_widen(&cut->reach, rounded);
    sbi_cut_box_widen(&reach, sb_max(margin, rounded));
    sbi_cut_list_near(cut, &now, &reach);
}

/* After sbi_cut_list_reached: does it in one frame for all the body; where parts of it have gone far apart, in one for
 * each part, which no link leaves: otherwise the distance between them would take the digits that a cut needs. 0: no
 * memory. */
static int sbi_cut_in_frames(sb_cut *cut, const sb_vec3 *triangles, int count, sbi_cut_frame_work *work)
{
    int parts = cut->body->component_count, swept = 1;
    if (!cut->near.count)
        return 1;
    if (sbi_cut_size_of(&cut->now) <= SBI_CUT_SPREAD * cut->rest_size)
        return sbi_cut_in_box(cut, &cut->now, SBI_CUT_ALL_PARTS, triangles, count, work);
    for (int part = 0; part < parts && swept; part++) {
        sbi_cut_box now = sbi_cut_box_of(cut, sb_body_positions(cut->body), part);
        swept = sbi_cut_in_box(cut, &now, part, triangles, count, work);
    }
    return swept;
}

SBI_API int sbi_cut_settle_seams(sb_cut *cut, const sb_vec3 *triangles, int count)
{
    sbi_cut_find_parted(cut);
    return sbi_cut_list_seams(cut) &&
           (!cut->seam_count || !count || sbi_cut_in_frames(cut, triangles, count, sbi_cut_sweep_seams)) &&
           sbi_cut_keep_seams(cut);
}

/* Links cut in a call, whose first new one is `first`. */
static int sbi_cut_count_cut(const sb_cut *cut, int first)
{
    int count = 0;
    for (int i = 0; i < cut->crossed.count; i++)
        count += cut->crossed.items[i] < first;
    for (int i = first; i < cut->links.count; i++)
        count += cut->links.items[i].state == SBI_LINK_CUT;
    return count;
}

static void sbi_cut_tell_info(const sb_cut *cut, int first, int ringed, sb_cut_info *info)
{
    info->links = sbi_cut_count_cut(cut, first);
    info->ringed = ringed;
    info->cells = cut->made_cells;
    info->nodes = cut->made_nodes;
    (void)sb_body_parts(cut->body, NULL, 0, &info->parts, NULL);
    info->glued = cut->glue_count;
    info->glued_area = cut->released.glued_area;
    info->released_area = cut->released.area;
    info->released_energy = cut->released.energy;
    info->crumbs = cut->removed.crumbs;
    info->removed_volume = (sb_real)cut->removed.volume;
    info->removed_mass = (sb_real)cut->removed.mass;
    info->removed_momentum =
        sb_v3((sb_real)cut->removed.momentum[0], (sb_real)cut->removed.momentum[1], (sb_real)cut->removed.momentum[2]);
}

SBI_API sb_result sbi_cut_finish(sb_cut *cut, int first, int ringed, int done, sb_cut_info *info, sb_error *error)
{
    sb_result result;
    if (done) {
        result = sbi_cut_part(cut, error);
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the links of a cut");
        sbi_cut_take_back_lost(cut);
        sbi_cut_clear(cut);
    }
    if (result != SB_OK) {
        sbi_cut_take_back(cut, first);
        return result;
    }
    if (info) {
        memset(info, 0, sizeof *info);
        sbi_cut_tell_info(cut, first, ringed, info);
    }
    cut->crossed.count = cut->receded_count = 0;
    sbi_cut_forget_struck(cut);
    return SB_OK;
}

/* Room for what a stroke may owe after this call; 0: no memory. */
static int sbi_cut_may_owe(const sb_cut *cut, sbi_cut_stroke *stroke)
{
    return !(cut->toughness > 0) || !stroke ||
           sbi_cut_reserve_debts(cut, stroke, stroke->debts.count + cut->freed.count);
}

SBI_API sb_result sbi_cut_along(sb_cut *cut, const sb_vec3 *triangles, int count, sbi_cut_stroke *stroke,
                                sb_cut_info *info, sb_error *error)
{
    sb_cut_info own;
    sb_result result;
    int links = cut->links.count, ringed = 0, swept = sbi_cut_in_frames(cut, triangles, count, sbi_cut_sweep_part);
    if (swept) {
        int before = sbi_cut_count_cut(cut, links);
        swept = cut->keeps_rings || sbi_cut_close_rings(cut, links);
        ringed = sbi_cut_count_cut(cut, links) - before;
    }
    if (swept)
        swept = sbi_cut_settle_seams(cut, triangles, count) && sbi_cut_may_owe(cut, stroke);
    info = info ? info : &own;
    result = sbi_cut_finish(cut, links, ringed, swept, info, error);
    if (result == SB_OK && cut->toughness > 0 && stroke)
        sbi_cut_pay(cut, stroke, triangles, info);
    return result;
}

SB_API sb_result sb_cut_triangles(sb_cut *cut, const sb_vec3 *triangles, int count, sb_cut_info *info, sb_error *error)
{
    sb_result result = sbi_cut_check_call(cut, triangles, count, error);
    if (result == SB_OK) {
        sbi_cut_list_reached(cut, triangles, 3 * count, 0);
        result = sbi_cut_along(cut, triangles, count, NULL, info, error);
    }
    if (result == SB_OK)
        sbi_cut_tell(cut, SBI_CUT_TRIANGLES, 0, triangles, 3 * count);
    return result;
}
