/* cut_along: cuts along triangles. */
#include "cut_private.h"

SBI_API sbi_cut_box sbi_cut_box_of(const sb_cut *cut, const sb_vec3 *x, int part)
{
    const sbi_slots *nodes = &cut->body->live->nodes;
    sbi_cut_box box = {{0, 0, 0}, {0, 0, 0}};
    int first = 1;
    for (int i = 0; i < nodes->end; i++) {
        if (!nodes->used[i] || !sbi_cut_is_of(cut, i, part))
            continue;
        if (first)
            box.low = box.high = x[i];
        first = 0;
        sbi_cut_box_add(&box, x[i]);
    }
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

/* Cuts the links of a part, or of all parts, in a frame about what lies in the box; 0: no memory. */
static int sbi_cut_sweep_box(sb_cut *cut, const sbi_cut_box *box, int part, const sb_vec3 *triangles, int count)
{
    sbi_crossing_frame frame;
    sbi_crossing_frame_make(box->low, box->high, &frame);
    return sbi_cut_take_blades(cut, &frame, triangles, count) && sbi_cut_sweep(cut, &frame, part);
}

SBI_API void sbi_cut_list_reached(sb_cut *cut, const sb_vec3 *points, int count, sb_real margin)
{
    const double rounding = 1.0 / (1 << 14); /* of the body's size: more than places are rounded by */
    sbi_cut_box now = sbi_cut_box_of(cut, sb_body_positions(cut->body), SBI_CUT_ALL_PARTS);
    sbi_cut_box reach = sbi_cut_box_around(points, count);
    sb_real rounded = (sb_real)(rounding * sbi_cut_size_of(&now));
    cut->reach = reach;
    sbi_cut_box_widen(&cut->reach, rounded);
    sbi_cut_box_widen(&reach, sb_max(margin, rounded));
    sbi_cut_list_near(cut, &now, &reach);
}

/* Cuts links in one frame for all the body; where parts of it have gone far apart, in one for each part, which no link
 * leaves: otherwise the distance between them would take the digits that a cut needs. 0: no memory. */
static int sbi_cut_sweep_body(sb_cut *cut, const sb_vec3 *triangles, int count)
{
    const sb_vec3 *x = sb_body_positions(cut->body);
    sbi_cut_box now = sbi_cut_box_of(cut, x, SBI_CUT_ALL_PARTS);
    int parts = cut->body->component_count, swept = 1;
    if (!cut->near.count)
        return 1;
    if (sbi_cut_size_of(&now) <= SBI_CUT_SPREAD * cut->rest_size)
        return sbi_cut_sweep_box(cut, &now, SBI_CUT_ALL_PARTS, triangles, count);
    for (int part = 0; part < parts && swept; part++) {
        now = sbi_cut_box_of(cut, x, part);
        swept = sbi_cut_sweep_box(cut, &now, part, triangles, count);
    }
    return swept;
}

SBI_API sb_result sbi_cut_along(sb_cut *cut, const sb_vec3 *triangles, int count, sb_cut_info *info, sb_error *error)
{
    int links = cut->links.count, crossed = links, swept = sbi_cut_sweep_body(cut, triangles, count);
    sb_result result;
    if (swept) {
        crossed = cut->links.count;
        swept = cut->keeps_rings || sbi_cut_close_rings(cut, links);
    }
    if (swept) {
        result = sbi_cut_part(cut, error);
    } else {
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for the links of a cut");
        sbi_cut_clear(cut);
    }
    if (result != SB_OK) {
        sbi_cut_links_truncate(&cut->links, links);
        return result;
    }
    if (info) {
        info->links = cut->links.count - links;
        info->ringed = cut->links.count - crossed;
        info->cells = cut->made_cells;
        info->nodes = cut->made_nodes;
        info->parts = cut->body->component_count;
    }
    return SB_OK;
}

SB_API sb_result sb_cut_triangles(sb_cut *cut, const sb_vec3 *triangles, int count, sb_cut_info *info, sb_error *error)
{
    sb_result result = sbi_cut_check_call(cut, triangles, count, error);
    if (result == SB_OK) {
        sbi_cut_list_reached(cut, triangles, 3 * count, 0);
        result = sbi_cut_along(cut, triangles, count, info, error);
    }
    if (result == SB_OK)
        sbi_cut_tell(cut, SBI_CUT_TRIANGLES, 0, triangles, 3 * count);
    return result;
}
