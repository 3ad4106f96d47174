/* step_static: static solves: load increments on the Newton iteration of steps. */
#include <string.h>

#include "cavity_law.h"
#include "constraint.h"
#include "load.h"
#include "rigid_private.h"
#include "step_private.h"

#define SBI_STATIC_COOKIE 0x57a71cu
enum { SBI_STATIC_NEWTON = 30 };

SB_API sb_static_options sb_default_static_options(void)
{
    sb_static_options options;
    memset(&options, 0, sizeof options);
    options.load_steps = 1;
    options.tolerance = (sb_real)1e-6;
    options.max_newton = SBI_STATIC_NEWTON;
    options.max_iterations = 20000;
    options.cookie = SBI_STATIC_COOKIE;
    return options;
}

SBI_API sb_result sbi_static_check_options(const sb_static_options *options, sb_error *error)
{
    if (options->cookie != SBI_STATIC_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the options were not made by sb_default_static_options");
    if (options->load_steps < 1 || options->max_newton < 1 || options->max_iterations < 1 ||
        !(options->tolerance > 0) || !(options->tolerance < 1) || (int)options->newton < SB_NEWTON_AUTO ||
        (int)options->newton > SB_NEWTON_MIXED_POINTS || (int)options->start < SB_START_AUTO ||
        (int)options->start > SB_START_ROTATIONS)
        return sbi_fail(error, SB_ERROR_ARGUMENT,
                        "load_steps, max_newton, max_iterations must be >= 1, tolerance in (0, 1), newton and start of "
                        "their kinds");
    return SB_OK;
}

static sb_result sbi_static_check(sb_body *body, const sb_static_options *options, sb_error *error)
{
    sb_result result;
    if (!body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a static solve needs a body");
    result = sbi_static_check_options(options, error);
    return result == SB_OK ? sbi_body_check_held(body, error) : result;
}

SBI_API void sbi_static_loads(sb_body *b, sb_real factor)
{
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_vec3 full = sb_v3_madd(b->dead_load[i], b->load_mass[i], b->gravity);
        b->external[i] = sb_v3_madd(b->equilibrated[i], factor, sb_v3_sub(full, b->equilibrated[i]));
    }
}

SBI_API sb_real sbi_static_duration(const sb_static_options *options)
{
    return options->instantaneous ? 0 : (sb_real)INFINITY;
}

/* Cavities hold what they press with, and the balance is found again, until their volumes are those of their laws or
 * come no closer. */
static sb_result sbi_static_hold_volumes(sbi_step *step, sb_result result)
{
    enum { ROUNDS = 30 };
    const double enough = (double)sb_max((sb_real)1e-11, 64 * SB_EPSILON);
    sb_body *b = step->body;
    double last = (double)SB_REAL_MAX;
    for (int round = 0; result == SB_OK && round < ROUNDS; round++) {
        double off = sbi_loads_hold_volumes(b, b->displacement, step->loads_factor);
        if (!(off > enough) || off > last / 2)
            break;
        last = off;
        step->norm = step->last_norm = 0;
        step->iteration = 1;
        step->done = step->energy_known = 0;
        result = sbi_step_iterate(step, sbi_step_linearise(step));
    }
    return result;
}

/* One increment: to balance, and with contact until its pressures hold the surface where it belongs. */
static sb_result sbi_static_iterate(sbi_step *step, const sb_static_options *options)
{
    sb_result result;
    sbi_static_begin_report(step);
    result = sbi_step_linearise(step);
    if (result == SB_OK && !step->done && sbi_static_may_start(step, options->start))
        result = sbi_static_start(step, sbi_static_duration(options));
    result = sbi_step_iterate(step, result);
    if (step->body->load_count && sbi_loads_are_stiff(step->body))
        result = sbi_static_hold_volumes(step, result);
    for (int round = 1; result == SB_OK && step->touch; round++) {
        int again = sbi_step_balance_touch(step, round);
        if (again < 0)
            return sbi_fail(&step->info->error, SB_ERROR_NOT_CONVERGED,
                            "a tool on a spring goes too far in one increment: take more load_steps");
        if (!again)
            break;
        step->norm = step->last_norm = 0;
        step->iteration = 1; /* contact has begun */
        step->done = 0;
        result = sbi_step_iterate(step, sbi_step_linearise(step));
    }
    if (result != SB_OK && result != SB_ERROR_INVERTED && sbi_static_settles(step)) {
        sbi_step_forget_error(step->info);
        result = SB_OK;
    }
    if (result != SB_OK)
        step->info->statics.reason = SB_STOP_NONE;
    step->info->statics.iterations = step->iteration;
    return result;
}

/* Raises the load factor to 1. An increment that fails goes back to the last converged one and is halved. */
static sb_result sbi_static_run(sbi_step *step, const sb_static_options *options)
{
    sb_body *b = step->body;
    size_t bytes = (size_t)b->domain.node_count * sizeof(sb_vec3);
    sb_real reached = 0, stride = (sb_real)1 / (sb_real)options->load_steps, least = stride / 64;
    memcpy(b->converged, b->displacement, bytes);
    sbi_loads_begin_static(b);
    sbi_cavities_keep(b);
    while (reached < 1) {
        int before = step->info->newton_iterations, spent;
        sb_result result;
        step->load_factor = sb_min((sb_real)1, reached + stride);
        if (step->load_factor > 1 - (sb_real)1e-3 * stride)
            step->load_factor = 1;
        step->loads_factor = step->load_factor;
        step->norm = step->last_norm = 0;
        step->energy_known = step->cautious = 0;
        step->quasi = options->quasi_newton != 0;
        sbi_static_loads(b, step->load_factor);
        sbi_rigids_begin_increment(step);
        step->iteration = step->done = 0;
        result = sbi_static_iterate(step, options);
        spent = step->info->newton_iterations - before;
        if (result != SB_OK) {
            memcpy(b->displacement, b->converged, bytes);
            sbi_cavities_go_back(b);
            b->force_current = 0;
            step->mixed = sbi_max_int(step->mixed - 1, 0);
            stride *= (sb_real)0.5;
            if (stride < least)
                return result;
            continue;
        }
        memcpy(b->converged, b->displacement, bytes);
        sbi_cavities_keep(b);
        sbi_rigids_end_increment(step);
        reached = step->load_factor;
        step->info->load_factor = reached;
        step->info->load_steps++;
        if (spent <= 5)
            stride *= (sb_real)1.5;
        if (options->progress)
            options->progress(options->progress_user, step->info);
    }
    return SB_OK;
}

enum { SBI_STATIC_MIXED = 4 }; /* halvings of an increment, and one more, before mixed points are given up */

/* How it iterates and solves. */
static void sbi_static_choose(sbi_step *step, const sb_static_options *options)
{
    const sb_real thin = 30;
    sb_body *b = step->body;
    int may_mix = !step->touch && !options->quasi_newton && !b->domain.single_rotation && !sbi_step_is_linear(b) &&
                  options->newton != SB_NEWTON_PLAIN;
    int is_thin = (b->auto_solver && !step->touch) || may_mix ? sb_body_slenderness(b) > thin : 0;
    step->mixed = may_mix && (is_thin || options->newton == SB_NEWTON_MIXED_POINTS) ? SBI_STATIC_MIXED : 0;
    if (is_thin)
        sbi_static_take_direct(step);
}

/* Takes the last converged increment as the body's state: at rest, with exact reactions. */
static void sbi_static_commit(sbi_step *step)
{
    sb_body *b = step->body;
    const sb_vec3 zero = sb_v3(0, 0, 0);
    size_t bytes = (size_t)b->domain.node_count * sizeof(sb_vec3);
    memset(b->velocity, 0, bytes);
    memset(b->acceleration, 0, bytes);
    sbi_body_update_positions(b);
    sbi_static_loads(b, step->info->load_factor);
    memcpy(b->equilibrated, b->external, bytes);
    sbi_loads_commit(b, b->displacement, b->displacement, step->info->load_factor, 0);
    sbi_loads_end_static(b, step->info->load_factor);
    if (sbi_step_force(step) == SB_OK) {
        for (int i = 0; i < b->domain.node_count; i++)
            b->work[i] = sb_v3_sub(b->internal[i], b->external[i]);
        if (step->touch)
            step->touch->add_done(step->touch->user, -1, b->work);
        if (b->elimination)
            sbi_constraint_reactions(b, b->work);
        for (int i = 0; !b->elimination && i < b->domain.node_count; i++)
            b->reaction[i] = sbi_body_pick_axes(b->node_component[i] < 0 ? 0 : b->fixed[i], b->work[i], zero);
    }
    sbi_rigids_end_static(step);
    b->acceleration_known = 0;
}

/* Recordings of before there was a choice have 0, and started from the present shape. */
static int sbi_static_start_code(sb_start start)
{
    return start == SB_START_PRESENT ? 0 : start == SB_START_AUTO ? 1 : (int)start;
}

static void sbi_static_tell(sb_body *body, const sb_static_options *options, sb_result result)
{
    const int ints[5] = {options->load_steps, options->max_newton, options->max_iterations, options->keep_progress,
                         (options->instantaneous != 0) + 2 * (options->quasi_newton != 0) +
                             4 * (options->forces_only != 0) + 8 * (int)options->newton +
                             32 * sbi_static_start_code(options->start)};
    sbi_body_tell(body, SBI_COMMAND_STATIC, (int)result, 0, ints, 5, &options->tolerance, 1);
}

SB_API sb_result sb_body_solve_static(sb_body *body, const sb_static_options *options, sb_step_info *info)
{
    sb_static_options defaults = sb_default_static_options();
    sb_step_info own;
    sbi_step step;
    sb_result result;
    sb_real duration;
    double begin;
    info = info ? info : &own;
    options = options ? options : &defaults;
    sbi_step_begin_info(info);
    result = sbi_static_check(body, options, &info->error);
    if (result != SB_OK)
        return result;
    begin = sbi_body_now(body);
    duration = sbi_static_duration(options);
    memset(&step, 0, sizeof step);
    step.body = body;
    step.part = 1;
    step.info = info;
    step.tolerance = sb_max(options->tolerance, 64 * SB_EPSILON);
    step.max_newton = sbi_max_int(options->max_newton, 2);
    step.max_iterations = options->max_iterations;
    step.line_search = 1;
    step.forces_only = options->forces_only;
    step.touch = body->touch;
    step.level = step.inertia_level = 1;
    result = sbi_rigids_begin_static(&step);
    if (result != SB_OK)
        return result;
    sbi_step_save(body);
    sbi_step_watch_folds(body, 0);
    sbi_step_enter(body, duration);
    sbi_static_choose(&step, options);
    result = sbi_static_run(&step, options);
    info->statics.newton = step.mixed ? SB_NEWTON_MIXED_POINTS : SB_NEWTON_PLAIN;
    info->statics.solver =
        sb_preconditioner_get_info(body->elimination ? body->elimination->precond : body->precond).kind;
    body->assembly.came_from = NULL;
    sbi_static_give_back_direct(&step);
    if (result == SB_OK || (options->keep_progress && info->load_steps > 0)) {
        sb_error error = info->error;
        sbi_static_commit(&step);
        if (step.touch)
            sbi_step_commit_touch(&step);
        sbi_step_leave(body, duration);
        info->error = error;
    } else {
        sbi_step_undo_guests(&step);
        sbi_step_undo_touch(&step);
        sbi_step_restore(body);
    }
    if (result == SB_OK)
        sbi_step_forget_error(info); /* of attempts with longer increments */
    info->seconds_total = sbi_body_now(body) - begin;
    sbi_static_tell(body, options, result);
    return sbi_step_report(info, result);
}
