/* steer_path: helices, what a bevel does, and distances of paths from obstacles. */
#include "steer_path.h"

/* ---- poses ---- */

NDLI_API sb_result ndli_pose_read(const ndl_tip_pose *tip, ndli_pose *pose)
{
    const ndl_frame *f = &tip->frame;
    ndli_v3 m1 = ndli_from(f->m1), m2 = ndli_from(f->m2), t = ndli_from(f->t), off;
    double length;
    if (!sb_v3_is_finite(tip->position) || !sb_v3_is_finite(f->m1) || !sb_v3_is_finite(f->m2) || !sb_v3_is_finite(f->t))
        return SB_ERROR_NOT_FINITE;
    off = ndli_sub(ndli_cross(m1, m2), t);
    if (!(fabs(ndli_norm(t) - 1) < 1e-3) || !(fabs(ndli_norm(m2) - 1) < 1e-3) || !(fabs(ndli_norm(m1) - 1) < 1e-3) ||
        !(ndli_norm(off) < 1e-3) || !(fabs(ndli_dot(m1, m2)) < 1e-3))
        return SB_ERROR_ARGUMENT;
    length = ndli_norm(t);
    pose->p = ndli_from(tip->position);
    pose->t = ndli_scale(1 / length, t);
    m2 = ndli_madd(m2, -ndli_dot(m2, pose->t), pose->t);
    pose->m2 = ndli_scale(1 / ndli_norm(m2), m2);
    pose->m1 = ndli_cross(pose->m2, pose->t);
    return SB_OK;
}

NDLI_API ndl_tip_pose ndli_pose_write(const ndli_pose *pose)
{
    ndl_tip_pose tip;
    tip.position = ndli_to(pose->p);
    tip.frame.m1 = ndli_to(pose->m1);
    tip.frame.m2 = ndli_to(pose->m2);
    tip.frame.t = ndli_to(pose->t);
    return tip;
}

static ndli_v3 ndli_pose_along(const ndli_pose *pose, ndli_v3 local)
{
    return ndli_madd(ndli_madd(ndli_scale(local.x, pose->m1), local.y, pose->m2), local.z, pose->t);
}

NDLI_API ndli_v3 ndli_pose_out(const ndli_pose *pose, ndli_v3 local)
{
    return ndli_add(pose->p, ndli_pose_along(pose, local));
}

NDLI_API ndli_v3 ndli_pose_in(const ndli_pose *pose, ndli_v3 point)
{
    ndli_v3 d = ndli_sub(point, pose->p);
    return ndli_v(ndli_dot(d, pose->m1), ndli_dot(d, pose->m2), ndli_dot(d, pose->t));
}

NDLI_API ndli_pose ndli_pose_turn(const ndli_pose *pose, double angle)
{
    ndli_pose r = *pose;
    double s, c;
    sbi_dense_sin_cos(angle, &s, &c);
    r.m1 = ndli_madd(ndli_scale(c, pose->m1), s, pose->m2);
    r.m2 = ndli_madd(ndli_scale(c, pose->m2), -s, pose->m1);
    return r;
}

/* ---- helices ---- */

/* sin(a)/a, (1 - cos a)/a^2, (a - sin a)/a^3 for a^2 = `square`, and (1/a) d/da of the last two. */
typedef struct ndli_helix_factors {
    double c0, c1, c2, d1, d2;
} ndli_helix_factors;

/* Below half a radian by series: the quotients would lose digits. */
static ndli_helix_factors ndli_helix_series(double a)
{
    ndli_helix_factors q;
    q.c2 = 1.0 / 6 - a * (1.0 / 120 - a * (1.0 / 5040 - a * (1.0 / 362880 - a * (1.0 / 39916800 - a / 6227020800.0))));
    q.c1 = 0.5 - a * (1.0 / 24 - a * (1.0 / 720 - a * (1.0 / 40320 - a * (1.0 / 3628800 - a / 479001600.0))));
    q.c0 = 1 - a * q.c2;
    q.d1 = -1.0 / 12 + a * (1.0 / 180 - a * (1.0 / 6720 - a * (1.0 / 453600 - a / 47900160.0)));
    q.d2 = -1.0 / 60 + a * (1.0 / 1260 - a * (1.0 / 60480 - a * (1.0 / 4989600 - a / 622702080.0)));
    return q;
}

static ndli_helix_factors ndli_helix_factors_of(double square)
{
    ndli_helix_factors q;
    double a, s, c;
    if (square < 0.25)
        return ndli_helix_series(square);
    a = sqrt(square);
    sbi_dense_sin_cos(a, &s, &c);
    q.c0 = s / a;
    q.c1 = (1 - c) / square;
    q.c2 = (1 - q.c0) / square;
    q.d1 = (q.c0 - 2 * q.c1) / square;
    q.d2 = (q.c1 - 3 * q.c2) / square;
    return q;
}

/* The frame turns by the rotation vector s (-k, 0, w); p = s (I + c1 [v] + c2 [v]^2) (0, 0, 1). */
static ndli_v3 ndli_helix_point_of(const ndli_helix_factors *q, double k, double w, double s)
{
    double b = k * s;
    return ndli_v(-s * q->c2 * b * (w * s), s * q->c1 * b, s * (1 - q->c2 * b * b));
}

NDLI_API ndli_v3 ndli_helix_point(double k, double w, double s)
{
    ndli_helix_factors q = ndli_helix_factors_of(s * s * (k * k + w * w));
    return ndli_helix_point_of(&q, k, w, s);
}

NDLI_API ndli_helix_end ndli_helix_derive(double k, double w, double s)
{
    ndli_helix_factors q = ndli_helix_factors_of(s * s * (k * k + w * w));
    ndli_helix_end e;
    double b = k * s, x = w * s;
    e.p = ndli_helix_point_of(&q, k, w, s);
    e.ds = ndli_v(-q.c1 * b * x, q.c0 * b, 1 - q.c1 * b * b);
    e.dw = ndli_scale(s * s, ndli_v(-b * (q.c2 + q.d2 * x * x), b * x * q.d1, -b * b * x * q.d2));
    return e;
}

NDLI_API ndli_pose ndli_pose_helix(const ndli_pose *pose, double k, double w, double s)
{
    ndli_helix_factors q = ndli_helix_factors_of(s * s * (k * k + w * w));
    double b = k * s, x = w * s;
    ndli_pose r;
    r.p = ndli_pose_out(pose, ndli_helix_point_of(&q, k, w, s));
    r.t = ndli_pose_along(pose, ndli_v(-q.c1 * b * x, q.c0 * b, 1 - q.c1 * b * b));
    r.m2 = ndli_pose_along(pose, ndli_v(-q.c0 * x, 1 - q.c1 * (b * b + x * x), -q.c0 * b));
    r.t = ndli_scale(1 / ndli_norm(r.t), r.t);
    r.m2 = ndli_madd(r.m2, -ndli_dot(r.m2, r.t), r.t);
    r.m2 = ndli_scale(1 / ndli_norm(r.m2), r.m2);
    r.m1 = ndli_cross(r.m2, r.t);
    return r;
}

static ndli_pose ndli_pose_raw(const ndl_tip_pose *tip)
{
    ndli_pose pose;
    pose.p = ndli_from(tip->position);
    pose.m1 = ndli_from(tip->frame.m1);
    pose.m2 = ndli_from(tip->frame.m2);
    pose.t = ndli_from(tip->frame.t);
    return pose;
}

static ndl_tip_pose ndli_pose_none(void)
{
    ndl_tip_pose none;
    memset(&none, 0, sizeof none);
    return none;
}

NDL_API ndl_tip_pose ndl_helix_pose(const ndl_tip_pose *start, sb_real curvature, sb_real twist, sb_real length)
{
    ndli_pose pose;
    if (!start)
        return ndli_pose_none();
    pose = ndli_pose_raw(start);
    pose = ndli_pose_helix(&pose, (double)curvature, (double)twist, (double)length);
    return ndli_pose_write(&pose);
}

NDL_API ndl_tip_pose ndl_tip_turn(const ndl_tip_pose *start, sb_real angle)
{
    ndli_pose pose;
    if (!start)
        return ndli_pose_none();
    pose = ndli_pose_raw(start);
    pose = ndli_pose_turn(&pose, (double)angle);
    return ndli_pose_write(&pose);
}

NDL_API sb_real ndl_helix_radius(sb_real curvature, sb_real twist)
{
    return curvature / (curvature * curvature + twist * twist);
}

NDL_API sb_real ndl_helix_pitch(sb_real curvature, sb_real twist)
{
    return (sb_real)6.283185307179586 * sb_abs(twist) / (curvature * curvature + twist * twist);
}

/* ---- bevels ---- */

static double ndli_steer_tan(double angle)
{
    double s, c;
    sbi_dense_sin_cos(angle, &s, &c);
    return s / c;
}

static sb_result ndli_bevel_check(const ndl_bevel *bevel, double d, double l)
{
    if (!bevel)
        return SB_ERROR_ARGUMENT;
    if (!sb_is_finite(bevel->angle) || !sb_is_finite(bevel->curvature) || !sb_is_finite(bevel->guide) ||
        !sb_is_finite(bevel->lag) || !ndli_is_finite(d) || !ndli_is_finite(l))
        return SB_ERROR_NOT_FINITE;
    if (!(l > 0))
        return SB_ERROR_ARGUMENT;
    if (bevel->law == NDL_BEVEL_ANGLE)
        return fabs((double)bevel->angle) < 1.5 ? SB_OK : SB_ERROR_ARGUMENT;
    if (bevel->law == NDL_BEVEL_CURVATURE)
        return d <= 0 || fabs((double)bevel->curvature) * (l + d) <= 2 ? SB_OK : SB_ERROR_ARGUMENT;
    return SB_ERROR_ARGUMENT;
}

NDL_API sb_result ndl_bevel_offset(const ndl_bevel *bevel, sb_real advance, sb_real edge_length, sb_real *offset)
{
    double d = (double)advance, l = (double)edge_length, angle;
    sb_result result = ndli_bevel_check(bevel, d, l);
    if (result != SB_OK || !offset)
        return result != SB_OK ? result : SB_ERROR_ARGUMENT;
    angle = bevel->law == NDL_BEVEL_ANGLE ? (double)bevel->angle : 0.5 * (double)bevel->curvature * (l + d);
    *offset = (sb_real)(d > 0 ? d * ndli_steer_tan(angle) : 0);
    return SB_OK;
}

NDL_API sb_result ndl_bevel_curvature(const ndl_bevel *bevel, sb_real advance, sb_real edge_length, sb_real *curvature)
{
    double d = (double)advance, l = (double)edge_length;
    sb_result result = ndli_bevel_check(bevel, d, l);
    if (result != SB_OK || !curvature || !(d >= 0))
        return result != SB_OK ? result : SB_ERROR_ARGUMENT;
    /* the angle is the one inscribed in the circle over the chord l + d, about */
    *curvature = bevel->law == NDL_BEVEL_CURVATURE ? bevel->curvature
                                                   : (sb_real)(2 * ndli_steer_tan((double)bevel->angle) / (l + d));
    return SB_OK;
}

NDL_API sb_result ndl_bevel_shift(sb_real offset, sb_vec3 m2, const sb_mat3 *deformation, sb_vec3 *shift)
{
    sb_real size = 0, det;
    sb_vec3 x;
    if (!deformation || !shift)
        return SB_ERROR_ARGUMENT;
    for (int i = 0; i < 9; i++)
        size += sb_abs(deformation->m[i / 3][i % 3]);
    if (!sb_is_finite(size) || !sb_is_finite(offset) || !sb_v3_is_finite(m2))
        return SB_ERROR_NOT_FINITE;
    det = sb_m3_det(*deformation);
    if (!(det > 0))
        return SB_ERROR_INVERTED;
    x = sb_v3_scale(offset, sb_m3_apply(sb_m3_inverse(*deformation), m2));
    if (!sb_v3_is_finite(x))
        return SB_ERROR_INVERTED;
    *shift = x;
    return SB_OK;
}

/* ---- obstacles ---- */

static double ndli_path_clamp(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

static double ndli_distance_capsule(const ndl_obstacle *o, ndli_v3 p)
{
    ndli_v3 axis = ndli_sub(ndli_from(o->b), ndli_from(o->a)), d = ndli_sub(p, ndli_from(o->a));
    double square = ndli_dot(axis, axis), at = square > 0 ? ndli_path_clamp(ndli_dot(d, axis) / square, 0, 1) : 0;
    return ndli_norm(ndli_madd(d, -at, axis)) - (double)o->radius;
}

static double ndli_distance_cylinder(const ndl_obstacle *o, ndli_v3 p)
{
    ndli_v3 axis = ndli_sub(ndli_from(o->b), ndli_from(o->a)), d = ndli_sub(p, ndli_from(o->a));
    double length = ndli_norm(axis), along = ndli_dot(d, axis) / length;
    double out = ndli_norm(ndli_madd(d, -along / length, axis)) - (double)o->radius;
    double past = fabs(along - 0.5 * length) - 0.5 * length;
    if (out > 0 && past > 0)
        return sqrt(out * out + past * past);
    return out > past ? out : past;
}

static double ndli_distance_shape(const sb_shape *shape, ndli_v3 p)
{
    if (shape->surface)
        return (double)sb_surface_signed_distance(shape->surface, ndli_to(p), NULL);
    return (double)shape->distance(shape->user, ndli_to(p)) / (double)shape->max_slope;
}

static double ndli_obstacle_distance(const ndl_obstacle *o, ndli_v3 p)
{
    if (o->kind == NDL_OBSTACLE_SPHERE)
        return ndli_norm(ndli_sub(p, ndli_from(o->a))) - (double)o->radius;
    if (o->kind == NDL_OBSTACLE_CAPSULE)
        return ndli_distance_capsule(o, p);
    if (o->kind == NDL_OBSTACLE_CYLINDER)
        return ndli_distance_cylinder(o, p);
    return o->kind == NDL_OBSTACLE_SHAPE && o->shape ? ndli_distance_shape(o->shape, p) : (double)SB_REAL_MAX;
}

NDL_API sb_real ndl_obstacle_distance(const ndl_obstacle *obstacle, sb_vec3 point)
{
    if (!obstacle)
        return SB_REAL_MAX;
    return (sb_real)ndli_obstacle_distance(obstacle, ndli_from(point));
}

NDLI_API double ndli_field_distance(const ndli_field *field, ndli_v3 p)
{
    double least = 1.7976931348623157e308;
    for (int i = 0; i < field->count; i++) {
        double d = ndli_obstacle_distance(field->obstacles + i, p);
        if (!(d >= least)) /* a distance that is no number counts as the nearest */
            least = d;
    }
    return least;
}

NDLI_API double ndli_field_march(const ndli_field *field, const ndli_pose *pose, double k, double w, double length,
                                 double slack, double *nearest)
{
    double s = 0, d;
    if (field->count == 0)
        return length;
    d = ndli_field_distance(field, pose->p);
    for (;;) {
        /* distances change by at most the way made, so half the room there is cannot be too far */
        double room = d - (field->clearance - slack * s * s * s), step, next;
        if (!(room >= 0))
            return 0;
        if (d < *nearest)
            *nearest = d;
        if (s >= length)
            return length;
        step = 0.5 * room > field->resolution ? 0.5 * room : field->resolution;
        step = s + step < length ? step : length - s;
        next = ndli_field_distance(field, ndli_pose_out(pose, ndli_helix_point(k, w, s + step)));
        if (!(next >= field->clearance - slack * (s + step) * (s + step) * (s + step)))
            return s;
        if (0.5 * (d + next - step) < *nearest)
            *nearest = 0.5 * (d + next - step);
        d = next;
        s = s + step < length ? s + step : length;
    }
}
