/* step_explicit: central differences in the form of velocities at the same times as displacements (Newmark beta 0,
 * gamma 1/2), which can change the length of its steps.
 *
 * What keeps it from exploding: substeps below the stable step, which comes from an upper bound of the highest
 * frequency at the present shape and is looked at again as the shape changes; and an energy monitor. A body has no
 * more energy than it had and was given since by loads and supports, up to a factor of order 1; where stiffness grows
 * faster than one looks, substeps multiply it. A call that breaks the monitor is done again with more caution, and what
 * the most cautious one arrives at opens a new monitor. Energy is that of the motion, of the body and of its springs;
 * to the rest of the forces the monitor gives credit for their work. Near the limit elastic energy swings, up to 1/(1 -
 * margin^2) times what its frequency has; what linear bodies keep in steps of h is the energy less h^2/8 a^T M a, and
 * that is what the monitor measures.
 *
 * Prony terms move on with every substep, so that between substeps, when forces, energy and bound are asked for, the
 * body responds as to a sudden strain: with its instantaneous stiffness, which the bound needs. Its long-term energy is
 * what the monitor can measure. The rest, which is in the terms and may yet come out, is gone with the longest
 * relaxation time at the latest.
 *
 * Constrained bodies move in the unknowns that are no slaves, u = T u' + b, with masses and forces handed on; see
 * sbi_constraint_explicit. */
#include "step_explicit.h"

#include <math.h>
#include <string.h>

#include "constraint.h"
#include "load.h"

enum { SBI_EXPLICIT_SWEEPS = 12 }; /* of the iteration for the bound: its gain per sweep is below 1 % then */

/* How a call goes about its way. */
typedef struct sbi_explicit_plan {
    sb_real margin; /* substeps are at most this share of the stable step */
    int interval;   /* substeps between looks, each of which costs as much as some ten forces */
    double factor;  /* energy over that of the monitor that is taken for granted */
} sbi_explicit_plan;

static const sbi_explicit_plan sbi_explicit_plans[SBI_EXPLICIT_CAUTION + 1] = {
    {(sb_real)0.9, 16, 1.5}, {(sb_real)0.45, 4, 1.5}, {(sb_real)0.225, 1, 1.25}, {(sb_real)0.08, 1, 1.25}};

typedef struct sbi_explicit {
    sb_body *body;
    sb_step_info *info;
    const sbi_explicit_plan *plan;
    int last_resort;     /* 1: the energy at the start of the call counts, whatever the monitor says */
    double start_energy; /* then (J) */
    double springs;      /* energy of springs and mappings at the present shape (J) */
    sb_real dt, h;       /* the call's time and the last substep (s) */
} sbi_explicit;

static double sbi_explicit_now(const sb_body *body) { return body->clock ? body->clock() : 0.0; }

/* Energy that rounding may pretend (J). */
static double sbi_explicit_noise(const sb_body *b) { return 64 * (double)SB_EPSILON * (double)b->assembly.energy_unit; }

/* ---- the stable step ---- */

/* 1/m of each axis of a node; 0 where there is no equation of motion, as at nodes of no element. */
static sb_vec3 sbi_explicit_inverse_mass(const sb_body *b, const sb_vec3 *masses, int i)
{
    sb_real m = b->lumped_mass[i];
    sb_vec3 all = masses ? masses[i] : sb_v3(m, m, m);
    return sb_v3(all.x > 0 ? 1 / all.x : (sb_real)0, all.y > 0 ? 1 / all.y : (sb_real)0,
                 all.z > 0 ? 1 / all.z : (sb_real)0);
}

/* y = M^-1 |K| x; returns the largest y_i / x_i, which no eigenvalue of M^-1 K exceeds. */
static sb_real sbi_explicit_sweep(const sb_body *b, const sb_matrix *matrix, const sb_vec3 *masses, const sb_vec3 *x,
                                  sb_vec3 *y)
{
    sb_real largest = 0;
    for (int i = 0; i < matrix->row_count; i++) {
        sb_vec3 sum = sb_v3(0, 0, 0), inverse = sbi_explicit_inverse_mass(b, masses, i);
        if (!(inverse.x + inverse.y + inverse.z > 0)) {
            y[i] = sum;
            continue;
        }
        for (int k = matrix->row_start[i]; k < matrix->row_end[i]; k++) {
            const sb_real *m = matrix->blocks[k];
            sb_vec3 v = x[matrix->columns[k]];
            sum.x += sb_abs(m[0]) * v.x + sb_abs(m[1]) * v.y + sb_abs(m[2]) * v.z;
            sum.y += sb_abs(m[3]) * v.x + sb_abs(m[4]) * v.y + sb_abs(m[5]) * v.z;
            sum.z += sb_abs(m[6]) * v.x + sb_abs(m[7]) * v.y + sb_abs(m[8]) * v.z;
        }
        y[i] = sb_v3(inverse.x * sum.x, inverse.y * sum.y, inverse.z * sum.z);
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
SBI_API sb_real sbi_explicit_bound(sb_body *b, const sb_matrix *matrix, const sb_vec3 *masses)
{
    sb_real least = SB_REAL_MAX, rounding = 1 + 64 * SB_EPSILON;
    for (int i = 0; i < matrix->row_count; i++)
        b->work[i] = sb_v3(1, 1, 1);
    for (int sweep = 0; sweep < SBI_EXPLICIT_SWEEPS; sweep++) {
        sb_real bound = sbi_explicit_sweep(b, matrix, masses, b->work, b->work2);
        if (!sb_is_finite(bound))
            return bound;
        least = sb_min(least, bound);
        sbi_explicit_normalise(b->work2, matrix->row_count, b->work);
    }
    return 2 / sb_sqrt(least * rounding);
}

/* The stable step at the present displacement, whose rotations are up to date. The positive part of the tangent bounds
 * the tangent; that of pressures has no sign and comes as it is. */
static sb_result sbi_explicit_stable_step(sb_body *b, sb_real *dt, sb_error *error)
{
    sb_real found;
    int bad;
    sbi_kept_spoil(b);
    bad = sbi_assembly_tangent(&b->assembly, b->displacement, SB_TANGENT_SPD, 1, &b->matrix);
    if (bad >= 0)
        return sbi_fail_element(error, SB_ERROR_INVERTED, bad,
                                "element %d is inside out, which its material does not allow", bad);
    if (b->load_count) {
        sbi_loads_stiffen(b, b->displacement, 1, 0, 0);
        sbi_loads_add_tangent(b, b->displacement, SB_TANGENT_EXACT, 1, &b->matrix);
        sbi_loads_add_slack(b, b->displacement, &b->matrix);
    }
    if (b->elimination) {
        sbi_elimination_condense(b->elimination, &b->matrix);
        sbi_constraint_masses(b);
        found = sbi_explicit_bound(b, &b->elimination->matrix, b->elimination->reduced);
    } else {
        found = sbi_explicit_bound(b, &b->matrix, NULL);
    }
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
    if (body->elimination)
        result = sbi_constraint_explicit_check(body, error);
    if (result != SB_OK)
        return result;
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

/* v^T M v / 2 */
static double sbi_explicit_square(const sb_body *b, const sb_vec3 *v)
{
    double sum = 0;
    for (int i = 0; i < b->domain.node_count; i++)
        sum += 0.5 * (double)b->lumped_mass[i] * (double)sb_v3_dot(v[i], v[i]);
    return b->elimination ? sum + sbi_constraint_lumped_energy(b, v) : sum;
}

static double sbi_explicit_kinetic(const sb_body *b) { return sbi_explicit_square(b, b->velocity); }

/* What steps of h seem to add to the elastic energy at the present accelerations, which supports have no part in
 * (J). */
static double sbi_explicit_swing(sb_body *b, sb_real h)
{
    for (int i = 0; i < b->domain.node_count; i++)
        b->work[i] = sbi_body_pick_axes(b->fixed[i], sb_v3(0, 0, 0), b->acceleration[i]);
    return (double)h * (double)h / 4 * sbi_explicit_square(b, b->work);
}

/* Elastic energy (J) as the monitor has it: of bodies with Prony terms the long-term one; to open a monitor with, the
 * present one where that is more. Returns -1 or the first inadmissible cell. */
static int sbi_explicit_elastic(sb_body *b, int opens, double *energy)
{
    sb_real now = 0, later = 0;
    int bad = sbi_assembly_energy(&b->assembly, b->displacement, &now);
    if (bad < 0 && b->assembly.viscous) {
        sbi_assembly_begin_step(&b->assembly, (sb_real)INFINITY);
        bad = sbi_assembly_energy(&b->assembly, b->displacement, &later);
        sbi_assembly_begin_step(&b->assembly, 0);
        now = opens ? sb_max(now, later) : later;
    }
    *energy = (double)now;
    return bad;
}

/* What is left, after the substeps since the last look, of energy that Prony terms may hold: it goes down with at least
 * twice the rate of the longest relaxation time. */
static double sbi_explicit_remains(const sbi_explicit *x)
{
    const sb_body *b = x->body;
    sb_real longest = 0;
    for (int i = 0; i < b->material_count; i++)
        for (int k = 0; k < b->materials[i].prony_count; k++)
            longest = sb_max(longest, b->materials[i].prony_tau[k]);
    return longest > 0 ? (double)sb_exp(-(sb_real)b->guard.age * x->h / longest) : 0;
}

/* Whether an energy agrees with the monitor; false for NaN and for more than numbers can hold. */
static sb_result sbi_explicit_audit(const sbi_explicit *x, double energy)
{
    const sb_body *b = x->body;
    double given = b->guard.energy > x->start_energy ? b->guard.energy : x->start_energy;
    if (energy - energy == 0 && energy <= x->plan->factor * given + sbi_explicit_noise(b))
        return SB_OK;
    for (int i = 0; i < b->domain.node_count; i++)
        if (!sb_v3_is_finite(b->velocity[i]))
            return sbi_fail_node(&x->info->error, SB_ERROR_DIVERGED, i, "the velocity of node %d is not finite", i);
    return sbi_fail(&x->info->error, SB_ERROR_DIVERGED, "the body has %g J, but was given no more than %g J", energy,
                    given);
}

/* Compares all energy with the monitor, takes what was lost off it, and finds the stable step of the present shape. */
static sb_result sbi_explicit_look(sbi_explicit *x)
{
    sb_body *b = x->body;
    sb_step_info *info = x->info;
    double begin = sbi_explicit_now(b), kinetic = sbi_explicit_kinetic(b), energy = 0, lost;
    int opens = !b->guard.monitor_open || (x->last_resort && info->substeps == 0);
    int bad = sbi_explicit_elastic(b, opens, &energy);
    sb_result result;
    if (bad >= 0)
        return sbi_fail_element(&info->error, SB_ERROR_INVERTED, bad,
                                "element %d is inside out, which its material does not allow", bad);
    energy += kinetic + x->springs;
    if (opens) {
        x->start_energy = energy;
        b->guard.energy = energy;
        b->guard.monitor_open = 1;
    }
    energy -= sbi_explicit_swing(b, x->h);
    energy = energy < kinetic ? kinetic : energy; /* forces of loads may make the difference too much; NaN stays */
    result = sbi_explicit_audit(x, energy);
    if (result != SB_OK)
        return result;
    lost = b->guard.energy - energy;
    if (lost > 0)
        b->guard.energy = b->assembly.viscous ? energy + lost * sbi_explicit_remains(x) : energy;
    b->guard.age = 0;
    result = sbi_explicit_stable_step(b, &b->guard.stable_step, &info->error);
    info->seconds_tangent += sbi_explicit_now(b) - begin;
    return result;
}

/* ---- motion ---- */

/* Forces at the present displacement: internal, and follower those of contact and of the loads that depend on it. met:
 * contact was met there, else it was left there by the last step. */
static sb_result sbi_explicit_force(sb_body *b, int met, sb_step_info *info)
{
    double begin = sbi_explicit_now(b);
    int bad = -1;
    if (b->load_count)
        sbi_loads_force(b, b->displacement, 1);
    else if (b->touch)
        memset(b->follower, 0, (size_t)b->domain.node_count * sizeof *b->follower);
    if (b->touch)
        sbi_explicit_add_touch(b, met);
    if (!b->force_current)
        bad = sbi_assembly_force(&b->assembly, b->displacement, b->internal);
    b->force_current = bad < 0;
    info->seconds_force += sbi_explicit_now(b) - begin;
    if (bad >= 0)
        return sbi_fail_element(&info->error, SB_ERROR_INVERTED, bad,
                                "element %d turned inside out, which its material does not allow", bad);
    return SB_OK;
}

/* All loads on a node. */
static sb_vec3 sbi_explicit_load(const sb_body *b, int i)
{
    return b->load_count || b->touch ? sb_v3_add(b->external[i], b->follower[i]) : b->external[i];
}

/* Acceleration of a node whose velocity so far is v, when it takes `share` (s) more of it: M a + alpha M (v + share a)
 * = f_ext - f_int. */
static sb_vec3 sbi_explicit_acceleration(const sb_body *b, int i, sb_vec3 v, sb_real share)
{
    sb_vec3 free_of_damping;
    if (!(b->lumped_mass[i] > 0))
        return sb_v3(0, 0, 0);
    free_of_damping = sb_v3_scale(1 / b->lumped_mass[i], sb_v3_sub(sbi_explicit_load(b, i), b->internal[i]));
    return sb_v3_scale(1 / (1 + b->damping_mass * share), sb_v3_madd(free_of_damping, -b->damping_mass, v));
}

/* The same of a constrained body, for all nodes at velocities v; supported axes have theirs already. */
static void sbi_explicit_constrained(sb_body *b, const sb_vec3 *v, sb_real share)
{
    sb_real scale = 1 / (1 + b->damping_mass * share);
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 force = sb_v3_sub(sbi_explicit_load(b, i), b->internal[i]);
        b->work[i] = sb_v3_scale(scale, sb_v3_madd(force, -b->damping_mass * b->lumped_mass[i], v[i]));
    }
    sbi_constraint_explicit(b, b->work, b->acceleration, 1);
}

/* Accelerations under the present loads. Supported axes run evenly to their targets through the whole call, and so do
 * the gaps of constraints: their velocity jumps at its start, which may bring energy in, and their acceleration is the
 * mean that this amounts to. */
static void sbi_explicit_begin(sb_body *b, sb_real dt)
{
    double before = sbi_explicit_kinetic(b), jump;
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 v = b->velocity[i], rate = sb_v3_scale(1 / dt, sb_v3_sub(b->target[i], b->start[i]));
        sb_vec3 change = sb_v3_scale(1 / dt, sb_v3_sub(rate, v));
        b->acceleration[i] = sbi_body_pick_axes(b->fixed[i], change, sbi_explicit_acceleration(b, i, v, 0));
    }
    if (b->elimination) {
        sbi_constraint_gap_rates(b, dt);
        sbi_explicit_constrained(b, b->velocity, 0);
    }
    for (int i = 0; i < b->domain.node_count; i++)
        b->velocity[i] =
            sbi_body_pick_axes(b->fixed[i], sb_v3_scale(1 / dt, sb_v3_sub(b->target[i], b->start[i])), b->velocity[i]);
    if (b->elimination)
        sbi_constraint_follow(b, b->velocity, 1 / dt);
    jump = sbi_explicit_kinetic(b) - before;
    b->guard.energy += jump > 0 ? jump : 0;
    if (b->load_count)
        b->guard.energy += sbi_loads_new_energy(b);
}

/* rhs = the part of the substep's moves, in increment, that supports and closing gaps bring about. */
static void sbi_explicit_find_driven(const sbi_explicit *x)
{
    sb_body *b = x->body;
    const sb_vec3 zero = sb_v3(0, 0, 0);
    for (int i = 0; i < b->domain.node_count; i++)
        b->rhs[i] = sbi_body_pick_axes(b->fixed[i], b->increment[i], zero);
    if (b->elimination)
        sbi_constraint_follow(b, b->rhs, x->h / x->dt);
}

/* Half of the work (J) of loads on the moves that are free, and of internal forces on driven ones, at the forces of
 * either end of the substep. The work of springs is in it on free moves only: supports do the rest. */
static double sbi_explicit_half_work(const sb_body *b)
{
    double work = 0;
    for (int i = 0; i < b->domain.node_count; i++)
        work += 0.5 * (double)sb_v3_dot(sbi_explicit_load(b, i), sb_v3_sub(b->increment[i], b->rhs[i])) +
                0.5 * (double)sb_v3_dot(b->internal[i], b->rhs[i]);
    return work;
}

/* Displacements after the substep, `done` of the call's way for supports and gaps; moves in increment. Returns half of
 * the work. */
static double sbi_explicit_move(const sbi_explicit *x, sb_real done)
{
    sb_body *b = x->body;
    sb_real h = x->h;
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 half = sb_v3_madd(b->velocity[i], h / 2, b->acceleration[i]), goal = b->target[i];
        if (b->fixed[i] && done < 1)
            goal = sb_v3_madd(b->start[i], done, sb_v3_sub(goal, b->start[i]));
        b->increment[i] = b->displacement[i];
        b->displacement[i] = sbi_body_pick_axes(b->fixed[i], goal, sb_v3_madd(b->displacement[i], h, half));
    }
    if (b->elimination)
        sbi_elimination_follow(b->elimination, b->displacement, done);
    for (int i = 0; i < b->domain.node_count; i++)
        b->increment[i] = sb_v3_sub(b->displacement[i], b->increment[i]);
    b->force_current = 0;
    sbi_explicit_find_driven(x);
    return sbi_explicit_half_work(b);
}

/* Velocities and accelerations at the end of the substep. */
static void sbi_explicit_accelerate(const sbi_explicit *x)
{
    sb_body *b = x->body;
    sb_real h = x->h;
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 half = sb_v3_madd(b->velocity[i], h / 2, b->acceleration[i]);
        b->velocity[i] = sbi_body_pick_axes(b->fixed[i], b->velocity[i], half);
        if (!b->elimination)
            b->acceleration[i] =
                sbi_body_pick_axes(b->fixed[i], b->acceleration[i], sbi_explicit_acceleration(b, i, half, h / 2));
    }
    if (b->elimination)
        sbi_explicit_constrained(b, b->velocity, h / 2);
    for (int i = 0; i < b->domain.node_count; i++)
        b->velocity[i] =
            sbi_body_pick_axes(b->fixed[i], b->velocity[i], sb_v3_madd(b->velocity[i], h / 2, b->acceleration[i]));
    if (b->elimination)
        sbi_constraint_follow(b, b->velocity, 1 / x->dt);
}

/* Work (J) that the mass of slaves takes on the moves that drive them. */
static double sbi_explicit_inertial_work(const sb_body *b)
{
    double work = 0;
    for (int i = 0; i < b->domain.node_count; i++)
        work += (double)b->lumped_mass[i] *
                (double)sb_v3_dot(sbi_body_pick_axes(b->elimination->slave[i], b->acceleration[i], sb_v3(0, 0, 0)),
                                  b->rhs[i]);
    return work;
}

/* One substep. A step that has gone bad shows in its kinetic energy, which is cheap to look at. */
static sb_result sbi_explicit_substep(sbi_explicit *x, sb_real done)
{
    sb_body *b = x->body;
    double work = sbi_explicit_move(x, done), springs;
    sb_result result;
    sbi_assembly_end_step(&b->assembly, b->displacement, x->h);
    result = b->touch ? sbi_explicit_meet_touch(b, &x->info->error) : SB_OK;
    if (result == SB_OK)
        result = sbi_explicit_force(b, 1, x->info);
    if (result != SB_OK)
        return result;
    work += sbi_explicit_half_work(b);
    sbi_explicit_accelerate(x);
    if (b->elimination)
        work += sbi_explicit_inertial_work(b);
    if (b->load_count) {
        springs = sbi_loads_energy(b, b->displacement);
        work += springs - x->springs; /* what they gave is theirs, not new */
        x->springs = springs;
    }
    b->guard.energy += work > 0 ? work : 0;
    b->guard.age++;
    x->info->substeps++;
    if (b->touch) {
        b->guard.energy += sbi_explicit_touch_swing(b, x->h);
        sbi_explicit_commit_touch(b);
    }
    return sbi_explicit_audit(x, sbi_explicit_kinetic(b));
}

/* Substeps as this plan would make them at the stable step last known; 0: none is. */
static sb_real sbi_explicit_length(const sb_body *b, sb_real dt, int caution)
{
    sb_real stable = b->guard.stable_step;
    return stable > 0 ? (sb_real)((double)dt / sbi_explicit_count(dt, sbi_explicit_plans[caution].margin * stable)) : 0;
}

/* Forces of the supports at the end of the call. */
static void sbi_explicit_reactions(sb_body *b)
{
    const sb_vec3 zero = sb_v3(0, 0, 0);
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 inertia = sb_v3_madd(b->acceleration[i], b->damping_mass, b->velocity[i]);
        b->work[i] = sb_v3_madd(sb_v3_sub(b->internal[i], sbi_explicit_load(b, i)), b->lumped_mass[i], inertia);
    }
    if (b->elimination)
        sbi_constraint_reactions(b, b->work);
    for (int i = 0; i < b->domain.node_count && !b->elimination; i++)
        b->reaction[i] = sbi_body_pick_axes(b->node_component[i] < 0 ? 0 : b->fixed[i], b->work[i], zero);
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
        if (!(b->guard.stable_step > 0) || b->guard.age >= x->plan->interval)
            result = sbi_explicit_look(x);
        if (result != SB_OK)
            return result;
        if (x->info->substeps == b->max_substeps)
            return sbi_fail(&x->info->error, SB_ERROR_NOT_CONVERGED,
                            "dt %g s takes more than max_substeps %d: the stable step is %g s", (double)dt,
                            b->max_substeps, (double)b->guard.stable_step);
        count = sbi_explicit_count(left, x->plan->margin * b->guard.stable_step);
        if (b->touch)
            result = sbi_explicit_begin_touch(b, left, x->plan->margin * b->guard.stable_step,
                                              (int)(x->plan - sbi_explicit_plans), &count, &x->info->error);
        if (result != SB_OK)
            return result;
        x->h = (sb_real)((double)left / count);
        left = count > 1 ? left - x->h : 0;
        result = sbi_explicit_substep(x, 1 - left / dt);
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
    sb_real before;
    sb_result result = body->elimination ? sbi_constraint_explicit_check(body, &info->error) : SB_OK;
    if (result != SB_OK)
        return result;
    x.body = body;
    x.info = info;
    x.plan = sbi_explicit_plans + caution;
    x.last_resort = caution == SBI_EXPLICIT_CAUTION;
    x.start_energy = 0;
    x.dt = dt;
    x.h = sbi_explicit_length(body, dt, caution);
    before = sbi_explicit_length(body, dt, body->guard.caution);
    x.springs = sbi_loads_energy(body, body->displacement);
    info->substeps = 0;
    if (!body->acceleration_known) /* the state came from outside */
        memset(&body->guard, 0, sizeof body->guard);
    if (caution > 0)
        body->guard.stable_step = 0;
    result = sbi_explicit_force(body, 0, info);
    if (result != SB_OK)
        return result;
    sbi_explicit_begin(body, dt);
    if (x.h < before) /* shorter steps show more of the energy there is */
        body->guard.energy += sbi_explicit_swing(body, before) - sbi_explicit_swing(body, x.h);
    result = sbi_explicit_go(&x, dt);
    if (result != SB_OK)
        return result;
    sbi_explicit_reactions(body);
    sbi_body_update_positions(body);
    body->acceleration_known = 1;
    return SB_OK;
}
