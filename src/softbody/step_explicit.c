/* step_explicit: central differences in the form of velocities at the same times as displacements (Newmark beta 0,
 * gamma 1/2), which can change the length of its steps.
 *
 * What keeps it from exploding: substeps below the stable step, which comes from an upper bound of the highest
 * frequency at the present shape and is looked at again as the shape changes; and a ledger of energy. A body has no
 * more energy than it had and was given since by loads and supports, up to a factor of order 1; where stiffness grows
 * faster than one looks, substeps multiply it. A call that breaks the ledger is done again with more caution, and what
 * the most cautious one arrives at opens a new ledger. */
#include "step_explicit.h"

#include <math.h>
#include <string.h>

enum { SBI_EXPLICIT_SWEEPS = 12 }; /* of the iteration for the bound: its gain per sweep is below 1 % then */

/* How a call goes about its way. */
typedef struct sbi_explicit_plan {
    sb_real margin;           /* substeps are at most this share of the stable step */
    int interval;             /* substeps between looks, each of which costs as much as some ten forces */
    double factor;            /* energy over that of the ledger that is taken for granted: near the limit, elastic
                               * energy swings to 1/(1 - margin^2) times what its frequency has */
} sbi_explicit_plan;

static const sbi_explicit_plan sbi_explicit_plans[SBI_EXPLICIT_CAUTION + 1] = {
    {(sb_real)0.9, 16, 1.5}, {(sb_real)0.45, 4, 1.5}, {(sb_real)0.225, 1, 1.25}, {(sb_real)0.08, 1, 1.25}};

typedef struct sbi_explicit {
    sb_body *body;
    sb_step_info *info;
    const sbi_explicit_plan *plan;
    int last_resort;          /* 1: the energy at the start of the call counts, whatever the ledger says */
    double start_energy;      /* then (J) */
} sbi_explicit;

static double sbi_explicit_now(const sb_body *body) { return body->clock ? body->clock() : 0.0; }

/* Energy that rounding may pretend (J). */
static double sbi_explicit_noise(const sb_body *b)
{
    return 64 * (double)SB_EPSILON * (double)b->assembly.energy_unit;
}

/* ---- the stable step ---- */

/* y = M^-1 |K| x; returns the largest y_i / x_i, which no eigenvalue of M^-1 K exceeds. */
static sb_real sbi_explicit_sweep(const sb_body *b, const sb_vec3 *x, sb_vec3 *y)
{
    const sb_matrix *matrix = &b->matrix;
    sb_real largest = 0;
    for (int i = 0; i < matrix->row_count; i++) {
        sb_vec3 sum = sb_v3(0, 0, 0);
        if (!(b->lumped_mass[i] > 0)) { /* of no element: no equation of motion */
            y[i] = sum;
            continue;
        }
        for (int k = matrix->row_start[i]; k < matrix->row_start[i + 1]; k++) {
            const sb_real *m = matrix->blocks[k];
            sb_vec3 v = x[matrix->columns[k]];
            sum.x += sb_abs(m[0]) * v.x + sb_abs(m[1]) * v.y + sb_abs(m[2]) * v.z;
            sum.y += sb_abs(m[3]) * v.x + sb_abs(m[4]) * v.y + sb_abs(m[5]) * v.z;
            sum.z += sb_abs(m[6]) * v.x + sb_abs(m[7]) * v.y + sb_abs(m[8]) * v.z;
        }
        y[i] = sb_v3_scale(1 / b->lumped_mass[i], sum);
        if (!sb_v3_is_finite(y[i]))
            return y[i].x + y[i].y + y[i].z;
        largest = x[i].x > 0 ? sb_max(largest, y[i].x / x[i].x) : largest;
        largest = x[i].y > 0 ? sb_max(largest, y[i].y / x[i].y) : largest;
        largest = x[i].z > 0 ? sb_max(largest, y[i].z / x[i].z) : largest;
    }
    return largest;
}

/* x = y over its largest component. A component of 0 has a row of zeros and stays out. */
static void sbi_explicit_normalise(const sb_vec3 *y, int count, sb_vec3 *x)
{
    sb_real size = 0;
    for (int i = 0; i < count; i++)
        size = sb_max(size, sb_max(y[i].x, sb_max(y[i].y, y[i].z)));
    for (int i = 0; i < count; i++)
        x[i] = sb_v3_scale(size > 0 ? 1 / size : 0, y[i]);
}

/* Every sweep gives a bound: the least of them counts. */
SBI_API sb_real sbi_explicit_bound(sb_body *b)
{
    sb_real least = SB_REAL_MAX, rounding = 1 + 64 * SB_EPSILON;
    for (int i = 0; i < b->matrix.row_count; i++)
        b->work[i] = sb_v3(1, 1, 1);
    for (int sweep = 0; sweep < SBI_EXPLICIT_SWEEPS; sweep++) {
        sb_real bound = sbi_explicit_sweep(b, b->work, b->work2);
        if (!sb_is_finite(bound))
            return bound;
        least = sb_min(least, bound);
        sbi_explicit_normalise(b->work2, b->matrix.row_count, b->work);
    }
    return 2 / sb_sqrt(least * rounding);
}

/* The stable step at the present displacement, whose rotations are up to date. The positive part of the tangent bounds
 * the tangent. */
static sb_result sbi_explicit_stable_step(sb_body *b, sb_real *dt, sb_error *error)
{
    sb_real found;
    int bad = sbi_assembly_tangent(&b->assembly, b->displacement, SB_TANGENT_SPD, 1, &b->matrix);
    if (bad >= 0)
        return sbi_fail_element(error, SB_ERROR_INVERTED, bad,
                                "element %d is inside out, which its material does not allow", bad);
    found = sbi_explicit_bound(b);
    if (!(found > 0) || !sb_is_finite(found))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "the stiffness is beyond what numbers can hold");
    *dt = found;
    return SB_OK;
}

SB_API sb_result sb_body_stable_step(sb_body *body, sb_real *dt, sb_error *error)
{
    sb_result result = SB_OK;
    int bad = -1;
    if (!body || !dt)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_stable_step needs a body and a place for dt");
    if (body->force_current)
        return sbi_explicit_stable_step(body, dt, error);
    sbi_assembly_save_rotations(&body->assembly); /* forces leave traces in the warm starts */
    bad = sbi_assembly_force(&body->assembly, body->displacement, body->residual);
    if (bad >= 0)
        result = sbi_fail_element(error, SB_ERROR_INVERTED, bad,
                                  "element %d is inside out, which its material does not allow", bad);
    else
        result = sbi_explicit_stable_step(body, dt, error);
    sbi_assembly_restore_rotations(&body->assembly);
    return result;
}

/* ---- looks at energy and stability ---- */

static double sbi_explicit_kinetic(const sb_body *b)
{
    double sum = 0;
    for (int i = 0; i < b->domain.node_count; i++)
        sum += 0.5 * (double)b->lumped_mass[i] * (double)sb_v3_dot(b->velocity[i], b->velocity[i]);
    return sum;
}

/* Whether an energy agrees with the ledger; false for NaN. */
static sb_result sbi_explicit_audit(const sbi_explicit *x, double energy)
{
    const sb_body *b = x->body;
    double given = b->guard.energy > x->start_energy ? b->guard.energy : x->start_energy;
    if (energy <= x->plan->factor * given + sbi_explicit_noise(b))
        return SB_OK;
    for (int i = 0; i < b->domain.node_count; i++)
        if (!sb_v3_is_finite(b->velocity[i]))
            return sbi_fail_node(&x->info->error, SB_ERROR_DIVERGED, i, "the velocity of node %d is not finite", i);
    return sbi_fail(&x->info->error, SB_ERROR_DIVERGED, "the body has %g J, but was given no more than %g J", energy,
                    given);
}

/* Compares all energy with the ledger, takes what was lost off it, and finds the stable step of the present shape. */
static sb_result sbi_explicit_look(sbi_explicit *x)
{
    sb_body *b = x->body;
    sb_step_info *info = x->info;
    double begin = sbi_explicit_now(b), energy;
    sb_real elastic = 0;
    int bad = sbi_assembly_energy(&b->assembly, b->displacement, &elastic);
    sb_result result;
    if (bad >= 0)
        return sbi_fail_element(&info->error, SB_ERROR_INVERTED, bad,
                                "element %d is inside out, which its material does not allow", bad);
    energy = (double)elastic + sbi_explicit_kinetic(b);
    if (!b->guard.ledger_open || (x->last_resort && info->substeps == 0)) {
        x->start_energy = energy;
        b->guard.energy = energy;
        b->guard.ledger_open = 1;
    }
    result = sbi_explicit_audit(x, energy);
    if (result != SB_OK)
        return result;
    b->guard.energy = energy < b->guard.energy ? energy : b->guard.energy;
    b->guard.age = 0;
    result = sbi_explicit_stable_step(b, &b->guard.stable_step, &info->error);
    info->seconds_tangent += sbi_explicit_now(b) - begin;
    return result;
}

/* ---- motion ---- */

/* internal = forces at the present displacement. What else depends on the shape belongs here too. */
static sb_result sbi_explicit_force(sb_body *b, sb_step_info *info)
{
    double begin = sbi_explicit_now(b);
    int bad = -1;
    if (!b->force_current)
        bad = sbi_assembly_force(&b->assembly, b->displacement, b->internal);
    b->force_current = bad < 0;
    info->seconds_force += sbi_explicit_now(b) - begin;
    if (bad >= 0)
        return sbi_fail_element(&info->error, SB_ERROR_INVERTED, bad,
                                "element %d turned inside out, which its material does not allow", bad);
    return SB_OK;
}

/* Acceleration of a node whose velocity so far is v, when it takes `share` (s) more of it: M a + alpha M (v + share a)
 * = f_ext - f_int. */
static sb_vec3 sbi_explicit_acceleration(const sb_body *b, int i, sb_vec3 v, sb_real share)
{
    sb_vec3 free_of_damping;
    if (!(b->lumped_mass[i] > 0))
        return sb_v3(0, 0, 0);
    free_of_damping = sb_v3_scale(1 / b->lumped_mass[i], sb_v3_sub(b->external[i], b->internal[i]));
    return sb_v3_scale(1 / (1 + b->damping_mass * share), sb_v3_madd(free_of_damping, -b->damping_mass, v));
}

/* Accelerations under the present loads. Supported axes run evenly to their targets through the whole call: their
 * velocity jumps at its start, which may bring energy in, and their acceleration is the mean that this amounts to. */
static void sbi_explicit_begin(sb_body *b, sb_real dt)
{
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 v = b->velocity[i], a = sbi_explicit_acceleration(b, i, v, 0);
        if (b->fixed[i]) {
            sb_vec3 rate = sb_v3_scale(1 / dt, sb_v3_sub(b->target[i], b->start[i]));
            sb_vec3 change = sb_v3_scale(1 / dt, sb_v3_sub(rate, v));
            b->velocity[i] = sbi_body_pick_axes(b->fixed[i], rate, v);
            a = sbi_body_pick_axes(b->fixed[i], change, a);
            b->guard.energy += 0.5 * (double)b->lumped_mass[i] *
                               (double)sb_max(0, sb_v3_dot(b->velocity[i], b->velocity[i]) - sb_v3_dot(v, v));
        }
        b->acceleration[i] = a;
    }
}

/* Displacements a substep of h on, `done` of the call's way for supports; moves in increment. Returns the work (J) of
 * loads and, at the forces before, half of that of supports. */
static double sbi_explicit_move(sb_body *b, sb_real h, sb_real done)
{
    const sb_vec3 zero = sb_v3(0, 0, 0);
    double work = 0;
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 half = sb_v3_madd(b->velocity[i], h / 2, b->acceleration[i]);
        sb_vec3 next = sb_v3_madd(b->displacement[i], h, half), go;
        if (b->fixed[i]) {
            sb_vec3 goal = b->target[i];
            if (done < 1)
                goal = sb_v3_madd(b->start[i], done, sb_v3_sub(goal, b->start[i]));
            next = sbi_body_pick_axes(b->fixed[i], goal, next);
        }
        go = sb_v3_sub(next, b->displacement[i]);
        work += (double)sb_v3_dot(b->external[i], sbi_body_pick_axes(b->fixed[i], zero, go)) +
                0.5 * (double)sb_v3_dot(b->internal[i], sbi_body_pick_axes(b->fixed[i], go, zero));
        b->increment[i] = go;
        b->displacement[i] = next;
    }
    b->force_current = 0;
    return work;
}

/* Velocities and accelerations at the end of the substep. Returns the other half of the work of supports. */
static double sbi_explicit_accelerate(sb_body *b, sb_real h)
{
    const sb_vec3 zero = sb_v3(0, 0, 0);
    double work = 0;
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 half = sb_v3_madd(b->velocity[i], h / 2, b->acceleration[i]);
        sb_vec3 a = sbi_explicit_acceleration(b, i, half, h / 2);
        work += 0.5 * (double)sb_v3_dot(b->internal[i], sbi_body_pick_axes(b->fixed[i], b->increment[i], zero));
        b->velocity[i] = sbi_body_pick_axes(b->fixed[i], b->velocity[i], sb_v3_madd(half, h / 2, a));
        b->acceleration[i] = sbi_body_pick_axes(b->fixed[i], b->acceleration[i], a);
    }
    return work;
}

/* One substep of h. A step that has gone bad shows in its kinetic energy, which is cheap to look at. */
static sb_result sbi_explicit_substep(const sbi_explicit *x, sb_real h, sb_real done)
{
    sb_body *b = x->body;
    double work = sbi_explicit_move(b, h, done);
    sb_result result = sbi_explicit_force(b, x->info);
    if (result != SB_OK)
        return result;
    work += sbi_explicit_accelerate(b, h);
    b->guard.energy += work > 0 ? work : 0;
    b->guard.age++;
    x->info->substeps++;
    return sbi_explicit_audit(x, sbi_explicit_kinetic(b));
}

/* Substeps that are needed for the rest of the way. A thousandth of a substep more or less is rounding. */
static double sbi_explicit_count(sb_real left, sb_real longest)
{
    double count = ceil((double)left / (double)longest - 1e-3);
    return count < 1 ? 1 : count;
}

/* Forces of the supports at the end of the call. */
static void sbi_explicit_reactions(sb_body *b)
{
    const sb_vec3 zero = sb_v3(0, 0, 0);
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 inertia = sb_v3_madd(b->acceleration[i], b->damping_mass, b->velocity[i]);
        sb_vec3 sum = sb_v3_madd(sb_v3_sub(b->internal[i], b->external[i]), b->lumped_mass[i], inertia);
        b->reaction[i] = sbi_body_pick_axes(b->node_component[i] < 0 ? 0 : b->fixed[i], sum, zero);
    }
}

/* All substeps of a call of dt. A shape that needs very short ones may be left soon: only the substeps that were taken
 * count against the cap. */
static sb_result sbi_explicit_go(sbi_explicit *x, sb_real dt)
{
    sb_body *b = x->body;
    sb_real left = dt;
    while (left > 0) {
        sb_result result = SB_OK;
        double count;
        sb_real h;
        if (!(b->guard.stable_step > 0) || b->guard.age >= x->plan->interval)
            result = sbi_explicit_look(x);
        if (result != SB_OK)
            return result;
        if (x->info->substeps == b->max_substeps)
            return sbi_fail(&x->info->error, SB_ERROR_NOT_CONVERGED,
                            "dt %g s takes more than max_substeps %d: the stable step is %g s", (double)dt,
                            b->max_substeps, (double)b->guard.stable_step);
        count = sbi_explicit_count(left, x->plan->margin * b->guard.stable_step);
        h = (sb_real)((double)left / count);
        left = count > 1 ? left - h : 0;
        result = sbi_explicit_substep(x, h, 1 - left / dt);
        if (result != SB_OK)
            return result;
    }
    return x->last_resort ? sbi_explicit_look(x) : SB_OK;
}

SBI_API void sbi_explicit_calm(sb_body *body, int caution)
{
    sbi_step_guard *guard = &body->guard;
    guard->calm = caution == guard->caution ? guard->calm + 1 : 1;
    guard->caution = caution;
    if (guard->calm >= 8 && caution > 0) {
        guard->caution--;
        guard->calm = 0;
    }
}

SBI_API sb_result sbi_explicit_run(sb_body *body, sb_real dt, int caution, sb_step_info *info)
{
    sbi_explicit x;
    sb_result result;
    x.body = body;
    x.info = info;
    x.plan = sbi_explicit_plans + caution;
    x.last_resort = caution == SBI_EXPLICIT_CAUTION;
    x.start_energy = 0;
    info->substeps = 0;
    if (!body->acceleration_known) /* the state came from outside */
        memset(&body->guard, 0, sizeof body->guard);
    if (caution > 0)
        body->guard.stable_step = 0;
    result = sbi_explicit_force(body, info);
    if (result != SB_OK)
        return result;
    sbi_explicit_begin(body, dt);
    result = sbi_explicit_go(&x, dt);
    if (result != SB_OK)
        return result;
    sbi_explicit_reactions(body);
    sbi_body_update_positions(body);
    body->acceleration_known = 1;
    return SB_OK;
}
