/* pose_view: what the caller knows of a pose: a rough start, from where the organ was seen, and that nothing was in
 * front of what the camera saw. */
#include "icp_private.h"

/* Where the target looks, in its frame; flip -1: its normals point inwards. */
static sb_vec3 regi_pose_view(const regi_icp *icp, int flip)
{
    const regi_icp_side *target = icp->swapped ? &icp->a : &icp->b;
    if (icp->target->has_camera)
        return regi_cloud_unit(sb_v3_sub(icp->target->camera, target->centre));
    return sb_v3_scale((sb_real)flip, regi_cloud_unit(regi_icp_facing(&target->spread)));
}

static sb_real regi_pose_square(sb_real x, sb_real slack, sb_real sd)
{
    sb_real beyond = sb_max(x - slack, 0) / sd;
    return beyond * beyond;
}

REGI_API sb_real regi_pose_prior(const regi_icp *icp, const regi_pose *pose, sb_real slack)
{
    const reg_icp_options *o = icp->options;
    const regi_icp_side *model = icp->swapped ? &icp->b : &icp->a;
    reg_rigid motion = regi_icp_of_model(icp, &pose->motion);
    sb_real sum = 0;
    if (o->start_shift_sd > 0 && o->start_turn_sd > 0) {
        reg_rigid back = reg_rigid_inverse(&o->start), between = reg_rigid_compose(&motion, &back);
        sb_real shift =
            sb_v3_norm(sb_v3_sub(reg_rigid_apply(&motion, model->centre), reg_rigid_apply(&o->start, model->centre)));
        sum += regi_pose_square(reg_rigid_angle(&between), slack, o->start_turn_sd);
        if (!(slack > 0))
            sum += regi_pose_square(shift, 0, o->start_shift_sd);
    }
    if (o->seen_from_sd > 0 && !icp->both) {
        sb_vec3 seen = sb_m3_tapply(motion.rotation, regi_pose_view(icp, pose->flip));
        sb_vec3 wanted = regi_cloud_unit(o->seen_from);
        sb_real angle = sb_atan2(sb_v3_norm(sb_v3_cross(seen, wanted)), sb_v3_dot(seen, wanted));
        sum += regi_pose_square(angle, slack, o->seen_from_sd);
    }
    return -sum / 2;
}

/* ==== free space ================================================================================================== */

enum { REGI_VIEW_CELLS = 32 }; /* along a side of the camera's image, at most */

/* What the camera saw of the target: the depth of the nearest point in each cell of an image. */
typedef struct regi_view {
    sb_vec3 camera, right, up, ahead;
    sb_real low[2], step[2];
    sb_real depth[REGI_VIEW_CELLS * REGI_VIEW_CELLS]; /* m; 0: nothing was seen there */
    int cells;
} regi_view;

/* A point's place in the image and its depth; 0 behind the camera. */
static int regi_view_project(const regi_view *view, sb_vec3 point, sb_real image[2], sb_real *depth)
{
    sb_vec3 ray = sb_v3_sub(point, view->camera);
    *depth = sb_v3_dot(ray, view->ahead);
    if (!(*depth > 0))
        return 0;
    image[0] = sb_v3_dot(ray, view->right) / *depth;
    image[1] = sb_v3_dot(ray, view->up) / *depth;
    return 1;
}

/* The cell of a place in the image, or -1 beside it. */
static int regi_view_cell(const regi_view *view, const sb_real image[2])
{
    int at[2];
    for (int k = 0; k < 2; k++) {
        sb_real cell = (image[k] - view->low[k]) / view->step[k];
        if (!(cell >= 0 && cell < (sb_real)view->cells))
            return -1;
        at[k] = (int)cell;
    }
    return at[1] * view->cells + at[0];
}

/* 0 where the camera's image has no size. */
static int regi_view_frame(const regi_icp_side *target, sb_vec3 camera, regi_view *view)
{
    sb_real high[2] = {-SB_REAL_MAX, -SB_REAL_MAX}, image[2], depth;
    view->camera = camera;
    view->ahead = regi_cloud_unit(sb_v3_sub(target->centre, camera));
    view->right = sb_v3_cross(view->ahead, sb_abs(view->ahead.x) < (sb_real)0.6 ? sb_v3(1, 0, 0) : sb_v3(0, 1, 0));
    view->right = regi_cloud_unit(view->right);
    view->up = sb_v3_cross(view->right, view->ahead);
    view->low[0] = view->low[1] = SB_REAL_MAX;
    for (int i = 0; i < target->spread.count; i++)
        for (int k = 0; k < 2 && regi_view_project(view, target->spread.points[i], image, &depth); k++) {
            view->low[k] = sb_min(view->low[k], image[k]);
            high[k] = sb_max(high[k], image[k]);
        }
    view->cells = sbi_min_int(REGI_VIEW_CELLS, (int)sb_sqrt((sb_real)target->spread.count / 3));
    for (int k = 0; k < 2; k++) /* a little more, so that the last point is inside */
        view->step[k] = (high[k] - view->low[k]) * (1 + 16 * SB_EPSILON) / (sb_real)sbi_max_int(view->cells, 1);
    return view->cells > 0 && view->step[0] > 0 && view->step[1] > 0 && sb_is_finite(view->step[0] + view->step[1]);
}

REGI_API sb_real regi_pose_in_front(const regi_icp *icp, const reg_rigid *motion)
{
    const regi_icp_side *target = icp->swapped ? &icp->a : &icp->b, *model = icp->swapped ? &icp->b : &icp->a;
    reg_rigid placed = regi_icp_of_model(icp, motion);
    sb_real image[2], depth, margin = (sb_real)0.02 * model->extent;
    regi_view view;
    int inside = 0, in_front = 0;
    if (!icp->target->has_camera || !regi_view_frame(target, icp->target->camera, &view))
        return 0;
    memset(view.depth, 0, sizeof view.depth);
    for (int i = 0; i < target->spread.count; i++) {
        int cell =
            regi_view_project(&view, target->spread.points[i], image, &depth) ? regi_view_cell(&view, image) : -1;
        if (cell >= 0 && (!(view.depth[cell] > 0) || depth < view.depth[cell]))
            view.depth[cell] = depth;
    }
    for (int i = 0; i < model->spread.count; i++) {
        sb_vec3 at = reg_rigid_apply(&placed, model->spread.points[i]);
        int cell = regi_view_project(&view, at, image, &depth) ? regi_view_cell(&view, image) : -1;
        if (cell < 0 || !(view.depth[cell] > 0))
            continue;
        inside++;
        in_front += depth < view.depth[cell] - margin;
    }
    return inside > 0 ? (sb_real)in_front / (sb_real)inside : 0;
}
