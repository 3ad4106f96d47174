/* steer_push: the manipulator that moves a point inside the tissue onto a path, or out of its way. */
#include "steer_push.h"

static const unsigned ndli_push_cookie = 0x70736831u;

/* What the force may be: |f| <= most and within the cone about `axis` (any direction when `grip`). */
typedef struct ndli_push_set {
    ndli_v3 axis;
    double sine, cosine, most;
    int grip;
} ndli_push_set;

NDL_API ndl_push_def ndl_default_push_def(void)
{
    ndl_push_def def;
    memset(&def, 0, sizeof def);
    def.cone = (sb_real)0.5;
    def.proportional = (sb_real)0.3;
    def.integral = 1;
    def.max_rate = SB_REAL_MAX;
    def.tolerance = (sb_real)5e-4;
    def.cookie = ndli_push_cookie;
    return def;
}

static ndli_v3 ndli_push_across(const ndl_push_def *def, ndli_v3 v)
{
    ndli_v3 t = ndli_from(def->line_direction);
    return ndli_madd(v, -ndli_dot(v, t), t);
}

/* The compliance across the path, P C with P = I - t t^T. */
static ndli_m3 ndli_push_compliance(const ndl_push_def *def, const sb_mat3 *compliance)
{
    ndli_m3 a;
    for (int j = 0; j < 3; j++) {
        ndli_v3 column = ndli_push_across(def, ndli_from(sb_m3_column(*compliance, j)));
        a.m[0][j] = column.x;
        a.m[1][j] = column.y;
        a.m[2][j] = column.z;
    }
    return a;
}

static double ndli_push_size(const ndli_m3 *a)
{
    double sum = 0;
    for (int i = 0; i < 9; i++)
        sum += a->m[i / 3][i % 3] * a->m[i / 3][i % 3];
    return sqrt(sum);
}

static ndli_push_set ndli_push_set_of(const ndl_push_def *def)
{
    ndli_push_set set;
    set.axis = ndli_from(def->direction);
    set.grip = !(ndli_dot(set.axis, set.axis) > 0);
    set.most = (double)def->max_force;
    sbi_dense_sin_cos((double)def->cone, &set.sine, &set.cosine);
    return set;
}

/* The nearest force of the set: first of the cone, then of the ball (a cone's nearest point scaled stays in it). */
static ndli_v3 ndli_push_project(const ndli_push_set *set, ndli_v3 f)
{
    double length;
    if (!set->grip) {
        double along = ndli_dot(f, set->axis);
        ndli_v3 side = ndli_madd(f, -along, set->axis);
        double out = ndli_norm(side);
        if (out * set->cosine > along * set->sine) { /* outside the cone: onto its nearest generator, or its apex */
            double on = along * set->cosine + out * set->sine;
            if (!(on > 0))
                return ndli_v(0, 0, 0);
            f = ndli_scale(on * set->cosine, set->axis);
            if (out > 0)
                f = ndli_madd(f, on * set->sine / out, side);
        }
    }
    length = ndli_norm(f);
    return length > set->most ? ndli_scale(set->most / length, f) : f;
}

/* The force of the set that minimises |A f - u|^2 + (1e-3 |A|)^2 |f|^2, by accelerated projected gradients (FISTA) from
 * `f`. The second term keeps forces that move nothing out; it costs an error of 1e-6 of u along the best direction. */
static ndli_v3 ndli_push_solve(const ndli_m3 *a, const ndli_push_set *set, ndli_v3 u, ndli_v3 f)
{
    double size = ndli_push_size(a), rate = 1 / (size * size * (1 + 1e-6)), momentum = 1;
    ndli_v3 ahead = f, now = f;
    for (int i = 0; i < 200; i++) {
        ndli_v3 r = ndli_sub(ndli_m_apply(a, ahead), u), g = ndli_m_tapply(a, r), next;
        double grown = 0.5 * (1 + sqrt(1 + 4 * momentum * momentum));
        g = ndli_madd(g, 1e-6 * size * size, ahead);
        next = ndli_push_project(set, ndli_madd(ahead, -rate, g));
        if (ndli_dot(ndli_sub(next, now), ndli_sub(ahead, next)) > 0) { /* past the goal: the momentum is lost */
            momentum = 1;
            ahead = next;
        } else {
            ahead = ndli_madd(next, (momentum - 1) / grown, ndli_sub(next, now));
            momentum = grown;
        }
        now = next;
    }
    return now;
}

/* ---- creation ---- */

static int ndli_push_positive(sb_real x) { return x > 0 && x <= SB_REAL_MAX; }
static int ndli_push_not_negative(sb_real x) { return x >= 0 && x <= SB_REAL_MAX; }

static int ndli_push_finite(const sb_mat3 *a)
{
    for (int i = 0; i < 9; i++)
        if (!sb_is_finite(a->m[i / 3][i % 3]))
            return 0;
    return 1;
}

static sb_result ndli_push_check(const ndl_push_def *def, sb_error *error)
{
    if (def->cookie != ndli_push_cookie)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def does not come from ndl_default_push_def()");
    if (!sb_v3_is_finite(def->line_point) || !sb_v3_is_finite(def->line_direction) || !sb_v3_is_finite(def->direction))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "line_point, line_direction or direction is not finite");
    if (!(sb_v3_norm(def->line_direction) > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "line_direction has no length");
    if (!ndli_push_not_negative(def->clear_radius) || !(def->cone >= 0) || !(def->cone <= (sb_real)1.5707964))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "clear_radius must not be negative, cone between 0 and pi/2");
    if (!ndli_push_positive(def->max_force) || !ndli_push_positive(def->max_rate) ||
        !ndli_push_positive(def->tolerance))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "max_force, max_rate and tolerance must be finite and above 0");
    if (!ndli_push_not_negative(def->proportional) || !ndli_push_not_negative(def->integral))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "proportional and integral must be finite and not negative");
    return SB_OK;
}

NDLI_API ndl_push_def ndli_push_unit(const ndl_push_def *def)
{
    ndl_push_def unit = *def;
    sb_real size = sb_v3_norm(def->direction);
    unit.line_direction = sb_v3_scale(1 / sb_v3_norm(def->line_direction), def->line_direction);
    if (size > 0)
        unit.direction = sb_v3_scale(1 / size, def->direction);
    return unit;
}

NDL_API sb_result ndl_push_begin(const ndl_push_def *def, ndl_push *push, sb_error *error)
{
    ndl_push_def unit;
    ndli_m3 a;
    sb_result result;
    if (!def || !push)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def or push is NULL");
    result = ndli_push_check(def, error);
    if (result != SB_OK)
        return result;
    if (!ndli_push_finite(&def->compliance))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "compliance is not finite");
    unit = ndli_push_unit(def);
    a = ndli_push_compliance(&unit, &unit.compliance);
    if (!(ndli_push_size(&a) > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "compliance moves nothing across the path");
    memset(push, 0, sizeof *push);
    push->def = unit;
    return SB_OK;
}

/* ---- control ---- */

NDLI_API ndli_v3 ndli_push_error(const ndl_push_def *def, ndli_v3 point)
{
    ndli_v3 off = ndli_push_across(def, ndli_sub(point, ndli_from(def->line_point)));
    double radius = (double)def->clear_radius, distance = ndli_norm(off), inside = distance;
    if (!(radius > 0))
        return ndli_scale(-1, off);
    if (distance >= radius)
        return ndli_v(0, 0, 0);
    if (!(distance > 0)) /* on the axis every way out is as far: the way the manipulator pushes, or any */
        off = ndli_push_across(def, ndli_from(def->direction)), distance = ndli_norm(off);
    if (!(distance > 1e-6))
        return ndli_scale(radius, ndli_from(sb_v3_perpendicular(def->line_direction)));
    return ndli_scale((radius - inside) / distance, off);
}

NDL_API sb_result ndl_push_update(ndl_push *push, sb_vec3 point, sb_real dt, sb_vec3 *force)
{
    ndli_push_set set;
    ndli_m3 a;
    ndli_v3 error, integral, asked, now, f, step, left;
    double most, distance;
    if (!push || !force || push->def.cookie != ndli_push_cookie || !(dt > 0))
        return SB_ERROR_ARGUMENT;
    if (!sb_v3_is_finite(point) || !sb_is_finite(dt))
        return SB_ERROR_NOT_FINITE;
    set = ndli_push_set_of(&push->def);
    a = ndli_push_compliance(&push->def, &push->def.compliance);
    error = ndli_push_error(&push->def, ndli_from(point));
    integral = ndli_madd(ndli_from(push->integral), (double)push->def.integral * (double)dt, error);
    asked = ndli_madd(integral, (double)push->def.proportional, error);
    now = ndli_from(push->force);
    f = ndli_push_solve(&a, &set, asked, now);
    step = ndli_sub(f, now);
    most = (double)push->def.max_rate * (double)dt;
    distance = ndli_norm(step);
    if (distance > most)
        f = ndli_madd(now, most / distance, step); /* both ends are in the set, and it is convex */
    left = ndli_sub(asked, ndli_m_apply(&a, f));
    push->limited = ndli_norm(left) > 1e-3 * (ndli_norm(asked) + (double)push->def.tolerance);
    if (!push->limited || ndli_dot(left, error) < 0)
        push->integral = ndli_to(integral);
    push->force = ndli_to(f);
    push->error = ndli_to(error);
    push->arrived = ndli_norm(error) <= (double)push->def.tolerance;
    *force = push->force;
    return SB_OK;
}

/* ---- where to push ---- */

NDLI_API double ndli_push_try(const ndl_push_def *unit, const sb_mat3 *compliance, ndli_v3 wanted, ndli_v3 *force)
{
    ndli_push_set set = ndli_push_set_of(unit);
    ndli_m3 a = ndli_push_compliance(unit, compliance);
    ndli_v3 none = ndli_v(0, 0, 0);
    *force = ndli_push_size(&a) > 0 ? ndli_push_solve(&a, &set, wanted, none) : none;
    return ndli_norm(ndli_sub(wanted, ndli_m_apply(&a, *force)));
}

NDL_API sb_result ndl_push_choose(const ndl_push_def *def, const sb_mat3 *compliances, const sb_vec3 *directions,
                                  int count, sb_vec3 point, int *best, sb_vec3 *force, sb_real *left, sb_error *error)
{
    ndl_push_def unit;
    ndli_v3 best_force = ndli_v(0, 0, 0);
    double best_left = 0;
    int found = -1, best_there = 0;
    sb_result result;
    if (!def || !compliances || !best || count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def, compliances or best is NULL, or there are no candidates");
    result = ndli_push_check(def, error);
    if (result != SB_OK)
        return result;
    if (!sb_v3_is_finite(point))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the point is not finite");
    for (int i = 0; i < count; i++)
        if (!ndli_push_finite(compliances + i) || (directions && !sb_v3_is_finite(directions[i])))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "candidate %d is not finite", i);
    for (int i = 0; i < count; i++) {
        ndl_push_def candidate = *def;
        ndli_v3 f;
        double rest;
        int there;
        if (directions)
            candidate.direction = directions[i];
        unit = ndli_push_unit(&candidate);
        rest = ndli_push_try(&unit, compliances + i, ndli_push_error(&unit, ndli_from(point)), &f);
        there = rest <= (double)def->tolerance;
        if (found < 0 || there > best_there ||
            (there == best_there && (there ? ndli_norm(f) < ndli_norm(best_force) : rest < best_left))) {
            found = i;
            best_force = f;
            best_left = rest;
            best_there = there;
        }
    }
    *best = found;
    if (force)
        *force = ndli_to(best_force);
    if (left)
        *left = (sb_real)best_left;
    return SB_OK;
}
