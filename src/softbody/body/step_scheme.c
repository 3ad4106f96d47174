/* step_scheme: the integrators of implicit steps: where they start and what they end with. */
#include <string.h>

#include "constraint.h"
#include "live_private.h"
#include "load.h"
#include "rigid_private.h"
#include "step_private.h"

SBI_API void sbi_step_dead_loads(sb_body *b)
{
    for (int i = 0; i < b->domain.node_count; i++)
        b->work[i] = b->gravity;
    sbi_body_mass_multiply(b, b->work, b->external);
    for (int i = 0; i < b->domain.node_count; i++)
        b->external[i] = sb_v3_add(b->external[i], b->dead_load[i]);
}

/* The same of a constrained body with its lumped mass: slaves hand forces and masses to their masters. */
static sb_result sbi_step_lumped_acceleration(sbi_step *step)
{
    sb_body *b = step->body;
    sb_result result = sbi_constraint_explicit_check(b, &step->info->error);
    if (result != SB_OK)
        return result;
    for (int i = 0; i < b->domain.node_count; i++) {
        b->work[i] = sb_v3_scale(-1, b->residual[i]);
        b->acceleration[i] = sb_v3(0, 0, 0);
    }
    sbi_constraint_explicit(b, b->work, b->acceleration, 0);
    return SB_OK;
}

/* How much of the tangent (s^2) holds accelerations that a step starts from. Those that forces give crumbs of a cut
 * have no bound, damping in proportion to stiffness makes them larger still, and generalised alpha, which forgets them
 * over steps, throws a crumb as far as they say: 450 m from a block of 6 cm (tests/test_cut_flat.c). So pieces take
 * those that an implicit step would: as good to second order, and the same where nothing is strained. */
static sb_real sbi_step_tangent_share(const sbi_step *step)
{
    const sb_body *b = step->body;
    if (!b->live || !b->live->piece_count || b->integrator != SB_GENERALISED_ALPHA)
        return 0;
    return step->dt * (step->dt / 4 + b->damping_stiffness / 2);
}

static void sbi_step_scale_matrix(sb_body *b, sb_real factor)
{
    for (int k = 0; k < b->matrix.block_count; k++)
        for (int c = 0; c < 9; c++)
            b->matrix.blocks[k][c] *= factor;
}

/* M a = -residual, or (M + tangent_share K) a, K being in the matrix. Guests are asked for what they do in a time that
 * is next to nothing, in which the unknown d stands for the acceleration ca d: as good as their forces and masses at
 * the start. Pushes count as over a step of it. */
static sb_result sbi_step_solve_acceleration(sbi_step *start, sb_real tangent_share)
{
    const sb_real instants = 1000; /* in a step: what a guest holds with a spring then counts a millionth */
    sb_body *b = start->body;
    sb_real unit = 1; /* 1/s^2: accelerations are so many times the unknown */
    sb_result result;
    if (start->guests.count > 0) {
        unit = start->ca = instants / start->dt * (instants / start->dt);
        start->known_velocity[0] = 1;
        start->starts = 1;
    }
    sbi_kept_spoil(b);
    if (tangent_share > 0)
        sbi_step_scale_matrix(b, tangent_share * unit);
    else
        sb_matrix_clear(&b->matrix);
    sbi_body_add_mass(b, unit);
    if (start->pushed)
        sbi_live_add_push_stiffness(b, unit * (start->dt * start->dt / 2));
    result = sbi_step_make_system(start);
    if (result == SB_OK)
        result = sbi_step_solve_system(start);
    for (int i = 0; result == SB_OK && i < b->domain.node_count; i++)
        b->acceleration[i] = sb_v3_scale(unit, b->increment[i]);
    sbi_step_undo_guests(start);
    return result;
}

/* M a = f_ext - f_int - D v: what Newmark starts from. Supported nodes start without acceleration. */
SBI_API sb_result sbi_step_initial_acceleration(sbi_step *step)
{
    sb_body *b = step->body;
    sb_result result = sbi_step_force(step);
    sbi_step start = *step;
    int n = b->domain.node_count;
    sb_real tangent_share = sbi_step_tangent_share(step);
    if (result != SB_OK)
        return result;
    start.cv = start.ca = 0;
    start.linear_tolerance = 100 * SB_EPSILON;
    start.max_iterations = sbi_max_int(step->max_iterations, 1000);
    memcpy(b->velocity0, b->velocity, (size_t)n * sizeof(sb_vec3));
    memset(b->acceleration0, 0, (size_t)n * sizeof(sb_vec3));
    start.has_velocity = 1;
    if (!start.lagged_damping || tangent_share > 0)
        sbi_step_tangent(&start, SB_TANGENT_QUASI);
    sbi_step_residual(&start);
    start.dynamic = 0;
    start.load_factor = 0;
    result = sbi_step_solve_acceleration(&start, tangent_share);
    if (result != SB_ERROR_INDEFINITE || b->mass_kind != SB_MASS_REDUCED)
        return result;
    if (b->elimination)
        return sbi_step_lumped_acceleration(step);
    for (int i = 0; i < n; i++) /* a reduced mass may be singular: its lumped sister is not */
        b->acceleration[i] =
            sbi_body_pick_axes(b->fixed[i], sb_v3(0, 0, 0), sb_v3_scale(-1 / b->lumped_mass[i], b->residual[i]));
    return SB_OK;
}

/* Generalised alpha (Chung and Hulbert 1993) in the unknown u at the level 1 - alpha_f of the step: with
 * d = (u - start) / level the Newmark rules give a' and v' at its end, and
 *     v = level v' + (1 - level) v_n,  a = inertia_level a' + (1 - inertia_level) a_n. */
static void sbi_step_scheme_alpha(sbi_step *step)
{
    sb_body *b = step->body;
    sb_real dt = step->dt, r = step->radius, level = 1 / (1 + r), inertia = (2 - r) / (1 + r);
    sb_real gamma = inertia - level + (sb_real)0.5, beta = (1 + inertia - level) * (1 + inertia - level) / 4;
    step->level = step->load_factor = level;
    step->inertia_level = inertia;
    step->cv = gamma / (beta * dt);
    step->ca = inertia / (beta * dt * dt * level);
    step->known_velocity[0] = 1 - level * gamma / beta;
    step->known_velocity[1] = level * dt * (1 - gamma / (2 * beta));
    step->known_acceleration[0] = -inertia / (beta * dt);
    step->known_acceleration[1] = 1 - inertia / (2 * beta);
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 v = b->velocity[i], a = b->acceleration[i];
        sb_vec3 v0 = sb_v3_madd(sb_v3_scale(step->known_velocity[0], v), step->known_velocity[1], a);
        sb_vec3 a0 = sb_v3_madd(sb_v3_scale(step->known_acceleration[1], a), step->known_acceleration[0], v);
        if (b->fixed[i]) {
            sb_vec3 go = sb_v3_sub(sbi_step_target(step, i), b->start[i]), rate = sb_v3_scale(1 / dt, go);
            sb_vec3 change = sb_v3_scale(1 / dt, sb_v3_sub(rate, v));
            sb_vec3 rate_now = sb_v3_madd(sb_v3_scale(1 - level, v), level, rate);
            sb_vec3 change_now = sb_v3_madd(sb_v3_scale(1 - inertia, a), inertia, change);
            v0 = sbi_body_pick_axes(b->fixed[i], sb_v3_madd(rate_now, -step->cv * level, go), v0);
            a0 = sbi_body_pick_axes(b->fixed[i], sb_v3_madd(change_now, -step->ca * level, go), a0);
        }
        b->velocity0[i] = v0;
        b->acceleration0[i] = a0;
    }
    if (b->elimination)
        sbi_constraint_scheme(b, step->cv, step->ca, dt, level, inertia);
    step->has_velocity = 1;
}

/* Implicit Euler and Newmark. Supported axes move evenly to their targets. */
static void sbi_step_scheme_newmark(sbi_step *step)
{
    sb_body *b = step->body;
    sb_real dt = step->dt;
    int newmark = b->integrator == SB_NEWMARK;
    step->cv = (newmark ? 2 : 1) / dt;
    step->ca = (newmark ? 4 : 1) / (dt * dt);
    step->known_velocity[0] = newmark ? (sb_real)-1 : (sb_real)0;
    step->known_velocity[1] = 0;
    step->known_acceleration[0] = newmark ? -4 / dt : -1 / dt;
    step->known_acceleration[1] = newmark ? (sb_real)-1 : (sb_real)0;
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 v = b->velocity[i], v0 = sb_v3(0, 0, 0), a0 = sb_v3_scale(-1 / dt, v);
        if (newmark) {
            v0 = sb_v3_scale(-1, v);
            a0 = sb_v3_sub(sb_v3_scale(-4 / dt, v), b->acceleration[i]);
        }
        if (b->fixed[i]) {
            sb_vec3 go = sb_v3_sub(sbi_step_target(step, i), b->start[i]), rate = sb_v3_scale(1 / dt, go);
            sb_vec3 change = sb_v3_scale(1 / dt, sb_v3_sub(rate, v));
            v0 = sbi_body_pick_axes(b->fixed[i], sb_v3_madd(rate, -step->cv, go), v0);
            a0 = sbi_body_pick_axes(b->fixed[i], sb_v3_madd(change, -step->ca, go), a0);
        }
        b->velocity0[i] = v0;
        b->acceleration0[i] = a0;
    }
    if (b->elimination)
        sbi_constraint_scheme(b, step->cv, step->ca, dt, 1, 1);
    step->has_velocity = newmark;
}

SBI_API void sbi_step_scheme(sbi_step *step)
{
    if (step->body->integrator == SB_GENERALISED_ALPHA)
        sbi_step_scheme_alpha(step);
    else
        sbi_step_scheme_newmark(step);
}

/* The value at the end of the step of what was `before` at its start and is `now` at the level of balance. */
static sb_vec3 sbi_step_extrapolate(sb_vec3 before, sb_vec3 now, sb_real level)
{
    return sb_v3_madd(before, 1 / level, sb_v3_sub(now, before));
}

/* Moves the displacement on to the end of the step, supports to their targets and slaves to where their masters have
 * them; `converged` keeps the shape of the balance. No line search has seen the new shape, so that it is tried where
 * the material forbids some (the next step finds its forces done). */
static sb_result sbi_step_finish_alpha(sbi_step *step)
{
    sb_body *b = step->body;
    memcpy(b->converged, b->displacement, (size_t)b->domain.node_count * sizeof(sb_vec3));
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 end = sbi_step_extrapolate(b->start[i], b->displacement[i], step->level);
        b->displacement[i] = b->fixed[i] ? sbi_body_pick_axes(b->fixed[i], sbi_step_target(step, i), end) : end;
    }
    sbi_rigids_place(b, b->displacement);
    if (b->elimination)
        sbi_elimination_follow(b->elimination, b->displacement, 1);
    b->force_current = 0;
    return sbi_step_allows_inversion(b) ? SB_OK : sbi_step_force(step);
}

/* Motion that was taken out of the end of a step counts in implicit Euler's velocity, which is the way over dt. Other
 * schemes would turn it into speed the other way: theirs is of the balance. */
static sb_vec3 sbi_step_taken_way(const sbi_step *step, int i)
{
    const sb_body *b = step->body;
    if (!step->moved || b->integrator == SB_EULER)
        return sb_v3(0, 0, 0);
    return sb_v3_sub(b->previous[i], b->displacement[i]);
}

SBI_API sb_result sbi_step_finish(sbi_step *step)
{
    sb_body *b = step->body;
    int alpha = b->integrator == SB_GENERALISED_ALPHA;
    sb_result moved = sbi_rigids_finish(step);
    if (moved != SB_OK)
        return moved;
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 taken = sbi_step_taken_way(step, i);
        sb_vec3 v = sb_v3_madd(sbi_step_velocity(step, i), step->cv, taken);
        sb_vec3 a = sb_v3_madd(sbi_step_acceleration(step, i), step->ca, taken);
        if (alpha) {
            v = sbi_step_extrapolate(b->velocity[i], v, step->level);
            a = sbi_step_extrapolate(b->acceleration[i], a, step->inertia_level);
        }
        if (!sb_v3_is_finite(v) || !sb_v3_is_finite(a))
            return sbi_fail_node(&step->info->error, SB_ERROR_DIVERGED, i, "the velocity of node %d is not finite", i);
        b->velocity[i] = v;
        if (!step->keeps_acceleration)
            b->acceleration[i] = a;
    }
    if (step->moved && b->integrator != SB_EULER)
        step->touch->brake(step->touch->user, b->displacement, b->velocity);
    if (alpha) {
        sb_result result = sbi_step_finish_alpha(step);
        if (result != SB_OK)
            return result;
    }
    sbi_body_update_positions(b);
    b->acceleration_known = 1;
    return SB_OK;
}
