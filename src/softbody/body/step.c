/* step: one Newton driver for time steps and static solves, time steps in parts, and explicit steps. See
 * step_residual.c for what is solved. */
#include "step.h"

#include <string.h>

#include "cavity_law.h"
#include "live_private.h"
#include "load.h"
#include "rigid_private.h"
#include "step_explicit.h"
#include "step_private.h"

/* ---- the Newton iteration ---- */

/* The exact tangent where its convergence pays. Far from the solution its directions are poor, which shows in short
 * increments; and while a time step still moves supports, no line search watches the increment, so that the tangent
 * must be safe by itself. */
static sb_tangent_kind sbi_step_first_kind(sbi_step *step)
{
    step->quasi = step->quasi && !(step->last_norm > 0 && step->norm > (sb_real)0.5 * step->last_norm);
    if (step->quasi)
        return SB_TANGENT_QUASI;
    return step->cautious || (step->dynamic && step->moves_supports) ? SB_TANGENT_SPD : SB_TANGENT_EXACT;
}

/* An exact tangent that is not positive definite is made anew, projected, and with it the system; other failures stay
 * what they are. */
static sb_result sbi_step_project(sbi_step *step, sb_result result)
{
    if (result == SB_ERROR_INDEFINITE && step->kind == SB_TANGENT_EXACT) {
        step->kind = SB_TANGENT_SPD;
        sbi_step_tangent(step, step->kind);
        result = sbi_step_make_system(step);
    }
    if (result == SB_ERROR_INDEFINITE)
        return sbi_fail(&step->info->error, result, "the projected tangent is not positive definite: %s",
                        step->moves_supports ? "supports move too far in one step"
                                             : "the body is not supported, or torn beyond what can be solved");
    return result;
}

/* Forces of guests that were left behind are none. */
static sb_result sbi_step_leave_guests(sbi_step *step)
{
    step->guests_lag = 1;
    return sbi_fail(
        &step->info->error, SB_ERROR_DIVERGED,
        "after %d linear solves the body has not let its guests (needles) go their way: take a shorter step",
        step->info->newton_iterations);
}

/* 1: the cap on iterations is hit, but guests are still on their way. */
static int sbi_step_waits_for_guests(const sbi_step *step)
{
    return sbi_step_guests_lag(step) && step->iteration / step->patience < step->max_newton;
}

SBI_API sb_result sbi_step_linearise(sbi_step *step)
{
    sb_result result = sbi_step_evaluate(step);
    if (result != SB_OK)
        return result;
    step->kind = SB_TANGENT_QUASI; /* in A already, of a linearised step */
    if (!step->linearised) {
        step->done = (step->dynamic ? sbi_step_is_converged(step) : sbi_static_is_done(step)) &&
                     (step->given.count == 0 || step->guests_begun);
        if (!step->done && step->iteration >= step->max_newton && !sbi_step_waits_for_guests(step)) {
            if (!step->dynamic || step->moves_supports)
                return SB_ERROR_NOT_CONVERGED;
            if (sbi_step_guests_lag(step))
                return sbi_step_leave_guests(step);
            step->done = step->info->capped = 1; /* each iteration lowered the potential */
        }
        if (step->done)
            return SB_OK;
        step->kind = sbi_step_first_kind(step);
        sbi_step_tangent(step, step->kind);
    }
    return sbi_step_project(step, sbi_step_make_system(step));
}

/* Solves a linearised step again whose tangent was kept too long: with its own. */
static sb_result sbi_step_solve_anew(sbi_step *step)
{
    sb_result result;
    sbi_step_undo_guests(step);
    sbi_kept_give_up(step);
    sbi_step_tangent(step, SB_TANGENT_QUASI);
    sbi_step_residual(step);
    result = sbi_step_make_system(step);
    return result == SB_OK ? sbi_step_solve_system(step) : result;
}

SBI_API sb_result sbi_step_solve(sbi_step *step)
{
    sb_result result = sbi_step_solve_system(step);
    if (result == SB_OK && step->keeps && !sbi_kept_was_near(step))
        result = sbi_step_solve_anew(step);
    if (result == SB_ERROR_INDEFINITE && step->kind == SB_TANGENT_EXACT) {
        result = sbi_step_project(step, result);
        if (result == SB_OK)
            result = sbi_step_solve_system(step);
    }
    return sbi_step_project(step, result);
}

/* The one iteration of a linearised step is done. Where the material forbids inverted elements the new shape is tried
 * at once (the next step finds its forces done): the body must stay steppable. */
static sb_result sbi_step_end_linearised(sbi_step *step)
{
    sb_body *b = step->body;
    for (int i = 0; step->line_search && i < b->domain.node_count; i++)
        b->increment[i] = sb_v3_sub(b->displacement[i], b->start[i]); /* a share of it: what the reactions go by */
    step->done = 1;
    if (sbi_step_guests_lag(step))
        return sbi_step_leave_guests(step);
    return sbi_step_allows_inversion(b) ? SB_OK : sbi_step_force(step);
}

SBI_API sb_result sbi_step_advance(sbi_step *step)
{
    sb_result result = sbi_step_accept(step);
    if (result != SB_OK)
        return sbi_step_project(step, result);
    step->iteration++;
    return step->linearised ? sbi_step_end_linearised(step) : sbi_step_linearise(step);
}

SBI_API sb_result sbi_step_iterate(sbi_step *step, sb_result begun)
{
    sb_result result = begun;
    while (result == SB_OK && !step->done) {
        result = sbi_step_solve(step);
        if (result == SB_OK)
            result = sbi_step_advance(step);
    }
    return result;
}

/* ---- begin and end ---- */

/* Of tools: a half ... a sixteenth of the way, none; giving way a little, and more; none, and the body stops for them
 * if the step is not divided. */
enum { SBI_STEP_TRIES = 7, SBI_STEP_STOP = SBI_STEP_TRIES + 1 };

/* What a failing step gives back, and where it is kept meanwhile. */
typedef struct sbi_step_pair {
    sb_vec3 *state, *saved;
} sbi_step_pair;

enum { SBI_STEP_PAIRS = 6 };

static void sbi_step_pairs(sb_body *b, sbi_step_pair pairs[SBI_STEP_PAIRS])
{
    sb_vec3 *const state[SBI_STEP_PAIRS] = {b->displacement, b->velocity, b->acceleration,
                                            b->reaction,     b->external, b->internal};
    sb_vec3 *const saved[SBI_STEP_PAIRS] = {b->start,          b->saved_velocity, b->saved_acceleration,
                                            b->saved_reaction, b->saved_external, b->saved_internal};
    for (int i = 0; i < SBI_STEP_PAIRS; i++) {
        pairs[i].state = state[i];
        pairs[i].saved = saved[i];
    }
}

SBI_API void sbi_step_save(sb_body *b)
{
    sbi_step_pair pairs[SBI_STEP_PAIRS];
    sbi_step_pairs(b, pairs);
    for (int i = 0; i < SBI_STEP_PAIRS; i++)
        memcpy(pairs[i].saved, pairs[i].state, (size_t)b->domain.node_count * sizeof(sb_vec3));
    if (b->elimination)
        sbi_elimination_save(b->elimination, b->start);
    b->saved_force_current = b->force_current;
    b->saved_fold_fallback = b->assembly.fold_fallback;
    b->saved_precond = sbi_precond_get_memory(b->precond);
    if (b->integrator == SB_CENTRAL_DIFFERENCE) /* its substeps move the memory on */
        sbi_assembly_save_memory(&b->assembly);
    sbi_assembly_save_rotations(&b->assembly);
    sbi_kept_save(b);
    sbi_cavities_save(b);
    sbi_rigids_save(b);
}

SBI_API void sbi_step_restore(sb_body *b)
{
    sbi_step_pair pairs[SBI_STEP_PAIRS];
    sbi_step_pairs(b, pairs);
    for (int i = 0; i < SBI_STEP_PAIRS; i++)
        memcpy(pairs[i].state, pairs[i].saved, (size_t)b->domain.node_count * sizeof(sb_vec3));
    if (b->elimination)
        sbi_elimination_restore(b->elimination);
    b->force_current = b->saved_force_current;
    b->assembly.fold_fallback = b->saved_fold_fallback;
    sbi_precond_set_memory(b->precond, b->saved_precond);
    if (b->integrator == SB_CENTRAL_DIFFERENCE)
        sbi_assembly_restore_memory(&b->assembly);
    sbi_assembly_restore_rotations(&b->assembly);
    sbi_kept_restore(b);
    sbi_cavities_restore(b);
    sbi_rigids_restore(b);
    sbi_body_update_positions(b);
}

SBI_API void sbi_step_begin_info(sb_step_info *info)
{
    memset(info, 0, sizeof *info);
    info->error.element = -1;
    info->error.node = -1;
}

/* Whether folded-over cells get one rotation; forces that were made under the other rule are made anew. */
SBI_API void sbi_step_watch_folds(sb_body *b, int fold_fallback)
{
    if (b->assembly.fold_fallback != fold_fallback)
        b->force_current = 0;
    b->assembly.fold_fallback = fold_fallback;
}

SBI_API void sbi_step_forget_error(sb_step_info *info)
{
    memset(&info->error, 0, sizeof info->error);
    info->error.element = info->error.node = -1;
}

/* Sees to it that a failing call says why, whatever failed. */
SBI_API sb_result sbi_step_report(sb_step_info *info, sb_result result)
{
    if (result != SB_OK && info->error.result != result) {
        if (result == SB_ERROR_NOT_CONVERGED)
            sbi_fail(&info->error, result, "the residual is %g after %d linear solves", (double)info->residual,
                     info->newton_iterations);
        else
            sbi_fail(&info->error, result, "the linear solve failed (%s)", sb_result_string(result));
    }
    return result;
}

/* Materials with Prony terms respond as over a step of dt from now on. */
SBI_API void sbi_step_enter(sb_body *b, sb_real dt)
{
    if (sbi_assembly_begin_step(&b->assembly, dt))
        b->force_current = 0;
}

/* The step of dt is done: their memory moves on. */
SBI_API void sbi_step_leave(sb_body *b, sb_real dt)
{
    if (sbi_assembly_end_step(&b->assembly, b->displacement, dt))
        b->force_current = 0;
}

/* ---- time steps ---- */

/* 1 when a linearised step may be taken as it is: forces that grow no faster than displacements. Those of hyperelastic
 * materials do, so that an increment that went too far would feed the next: there the line search watches it. */
static int sbi_step_is_tame(const sb_body *b)
{
    for (int i = 0; i < b->material_count; i++)
        if (sb_material_is_hyperelastic(b->materials[i].model))
            return 0;
    return 1;
}

static void sbi_step_set_up(sbi_step *step, sb_body *body, sb_real dt, sb_step_info *info)
{
    int is_explicit = body->integrator == SB_CENTRAL_DIFFERENCE;
    step->part = 1;
    step->body = body;
    step->info = info;
    step->dynamic = 1;
    step->dt = dt;
    step->load_factor = step->loads_factor = step->level = step->inertia_level = 1;
    step->radius = body->spectral_radius;
    step->max_newton = sbi_body_max_newton(body);
    step->linearised = step->max_newton == 1 && !is_explicit;
    step->max_iterations = body->max_iterations;
    step->tolerance = sb_max(body->newton_tolerance, 64 * SB_EPSILON);
    step->linear_tolerance = step->linearised ? body->tolerance : 0;
    step->line_search = !(step->linearised && sbi_step_is_tame(body));
    step->touch = is_explicit ? NULL : body->touch;
}

/* Checks the arguments and keeps what a failing step gives back. */
static sb_result sbi_step_open(sb_body *body, sb_real dt, sb_step_info *info, sbi_step *step)
{
    memset(step, 0, sizeof *step);
    step->part = 1;
    step->info = info ? info : &step->own_info;
    sbi_step_begin_info(step->info);
    if (!body || !(dt > 0) || !sb_is_finite(dt))
        return sbi_fail(&step->info->error, SB_ERROR_ARGUMENT, "a step needs a body and dt > 0, not %g", (double)dt);
    step->begun = sbi_body_now(body);
    sbi_step_set_up(step, body, dt, step->info);
    sbi_step_save(body);
    sbi_step_watch_folds(body, step->linearised);
    return SB_OK;
}

/* Whether a step can go on from the acceleration that the last one left, and leaves one to go on from. Differences of
 * displacements over a far shorter step than those around it are of rounding and of the solver's tolerance: such a step
 * leaves the acceleration that it found. (Half of its length is noted, lest many do so.) With a spectral radius below 1
 * generalised alpha leaves the acceleration of a time that is off by a share of its step (Arnold and Bruels 2007): one
 * of another length begins with M a = f, but where guests move within it, or tools and organs press. */
static void sbi_step_look_back(sbi_step *step)
{
    const sb_real another = 4, of_rounding = 1000;
    const sb_body *b = step->body;
    sb_real last = b->acceleration_step, dt = step->dt;
    int shifted = b->integrator == SB_GENERALISED_ALPHA && b->spectral_radius < 1;
    sb_real far_shorter = shifted ? 15 : of_rounding;
    if (b->integrator == SB_EULER)
        return;
    step->needs_acceleration = !b->acceleration_known;
    if (!b->acceleration_known || !(last > 0))
        return;
    step->keeps_acceleration = far_shorter * dt < last;
    if (shifted && step->guests.count == 0 && !step->touch && !step->keeps_acceleration)
        step->needs_acceleration = dt > another * last || last > another * dt;
    else
        step->needs_acceleration = dt > of_rounding * last;
}

/* An implicit step that was opened, up to its first linear system. */
static sb_result sbi_step_start(sbi_step *step)
{
    sb_body *b = step->body;
    sb_result result = SB_OK;
    sbi_step_dead_loads(b);
    sbi_live_add_pushes(b, b->external);
    step->pushed = sbi_live_hold_pushes(b, step->dt);
    if (sbi_body_has_beta(b) && (!step->linearised || (b->regional_damping && b->integrator != SB_EULER)))
        result = sbi_step_keep_damping(step);
    sbi_step_look_back(step);
    if (result == SB_OK && step->needs_acceleration)
        result = sbi_step_initial_acceleration(step);
    if (result != SB_OK)
        return result;
    sbi_step_scheme(step);
    step->push = step->pushed ? 1 / step->level : 0;
    sbi_step_enter(b, step->level * step->dt);
    step->info->newton_iterations = step->info->pcg_iterations = 0;
    return sbi_step_linearise(step);
}

/* What a step that went well leaves behind beside its state. */
static void sbi_step_settle(sbi_step *step)
{
    sb_body *b = step->body;
    const sb_vec3 *balance = b->integrator == SB_GENERALISED_ALPHA ? b->converged : b->displacement;
    if (b->integrator != SB_CENTRAL_DIFFERENCE)
        sbi_step_leave(b, step->dt);
    sbi_loads_commit(b, balance, step->linearised ? b->start : balance, 1, 1);
    sbi_step_forget_error(step->info); /* of a tangent that was projected after all */
    step->info->load_steps = 1;
    b->acceleration_step = step->keeps_acceleration ? b->acceleration_step / 2 : step->dt;
    if (!(step->part < 1)) /* the last part of a step that was divided */
        sbi_live_forget_pushes(b);
    sbi_step_commit_guests(step);
    if (step->touch)
        sbi_step_commit_touch(step);
}

static sb_result sbi_step_close(sbi_step *step, sb_result result)
{
    sb_step_info *info = step->info;
    info->load_factor = result == SB_OK ? (sb_real)1 : (sb_real)0;
    info->seconds_total = sbi_body_now(step->body) - step->begun;
    sbi_body_tell(step->body, SBI_COMMAND_STEP, (int)result, 0, NULL, 0, &step->dt, 1);
    return sbi_step_report(info, result);
}

static sb_result sbi_step_begin_part(sb_body *body, sb_real dt, const sbi_guest *const *guests, int guest_count,
                                     sb_real part, int patience, sb_step_info *info, sbi_step *step)
{
    sb_result result = sbi_step_open(body, dt, info, step);
    if (result != SB_OK)
        return result;
    step->part = part;
    step->patience = patience;
    if (body->integrator == SB_CENTRAL_DIFFERENCE)
        return sbi_fail(&step->info->error, SB_ERROR_UNSUPPORTED,
                        "an explicit step solves no system: it has no parts and no guests");
    result = sbi_rigids_join(step, &guests, &guest_count);
    if (result == SB_OK)
        result = sbi_step_take_guests(step, guests, guest_count);
    step->given = step->guests;
    return result == SB_OK ? sbi_step_start(step) : result;
}

SBI_API sb_result sbi_step_begin(sb_body *body, sb_real dt, const sbi_guest *const *guests, int guest_count,
                                 sb_step_info *info, sbi_step *step)
{
    return sbi_step_begin_part(body, dt, guests, guest_count, 1, 0, info, step);
}

/* Motion is taken out of the end of the step. */
static sb_result sbi_step_take_motion(sbi_step *step)
{
    sb_body *b = step->body;
    sbi_step_place_nodes(step, 1, b->displacement);
    if (b->elimination)
        sbi_elimination_follow(b->elimination, b->displacement, step->load_factor);
    b->force_current = step->energy_known = 0;
    return sbi_step_allows_inversion(b) ? SB_OK : sbi_step_force(step);
}

static sb_result sbi_step_mend_touch(sbi_step *step, int whole)
{
    if (!step->touch->mend(step->touch->user, step->body->displacement, whole))
        return SB_OK;
    step->moved = step->touch->mended = 1;
    return sbi_step_take_motion(step);
}

/* Organs that met go on together node by node; where the material does not admit that they do as wholes, from where
 * they were. */
static sb_result sbi_step_mend_apart(sbi_step *step)
{
    sb_body *b = step->body;
    size_t size = (size_t)b->domain.node_count * sizeof(sb_vec3);
    int moved = step->moved, mended = step->touch->mended;
    memcpy(b->work2, b->displacement, size);
    if (sbi_step_mend_touch(step, 0) == SB_OK)
        return SB_OK;
    step->moved = moved;
    step->touch->mended = mended;
    memcpy(b->displacement, b->work2, size);
    sbi_step_forget_error(step->info);
    return sbi_step_mend_touch(step, 1);
}

/* Where the material does not admit the rest all motion stays. */
static sb_result sbi_step_hold_touch(sbi_step *step)
{
    sbi_touch *touch = step->touch;
    sb_body *b = step->body;
    size_t size = (size_t)b->domain.node_count * sizeof(sb_vec3);
    memcpy(b->previous, b->displacement, size);
    step->moved = touch->hold(touch->user, b->displacement);
    if (!step->moved || sbi_step_take_motion(step) == SB_OK)
        return SB_OK;
    step->moved = 0;
    memcpy(b->displacement, b->previous, size);
    sbi_step_forget_error(step->info);
    return sbi_step_take_motion(step);
}

static sb_result sbi_step_stop_touch(sbi_step *step)
{
    step->touch->stop(step->touch->user, step->body->displacement);
    step->moved = step->touch->mended = 1;
    return sbi_step_take_motion(step);
}

static sb_result sbi_step_accept_touch(sbi_step *step)
{
    sbi_touch *touch = step->touch;
    sb_result held = sbi_step_hold_touch(step);
    int is_safe = held == SB_OK && touch->accept(touch->user, step->body->displacement);
    if (held != SB_OK)
        return held;
    if (touch->missed)
        return sbi_fail(&step->info->error, SB_ERROR_DIVERGED, "organs that were far apart may have met in this step");
    if (!is_safe && touch->apart && touch->is_last) {
        sb_result result = sbi_step_mend_apart(step);
        if (result != SB_OK)
            return result;
        is_safe = touch->accept(touch->user, step->body->displacement) || touch->apart;
    }
    if (!is_safe && step->tries == SBI_STEP_STOP) {
        sb_result result = sbi_step_stop_touch(step);
        if (result != SB_OK)
            return result;
        is_safe = touch->accept(touch->user, step->body->displacement) || touch->apart;
    }
    if (is_safe)
        return SB_OK;
    touch->refused = 1;
    return sbi_fail(&step->info->error, SB_ERROR_DIVERGED,
                    "the body moves so far in this step that a tool may have passed through it: take a shorter one");
}

SBI_API sb_result sbi_step_commit(sbi_step *step)
{
    sb_result result = step->touch ? sbi_step_accept_touch(step) : SB_OK;
    if (result != SB_OK)
        return result;
    sbi_step_reactions(step);
    result = sbi_step_finish(step);
    if (result != SB_OK)
        return result;
    sbi_step_settle(step);
    return sbi_step_close(step, SB_OK);
}

/* Generalised alpha extrapolates: where the material does not admit the end, the balance is tried at the end. */
static int sbi_step_can_balance_later(const sbi_step *step, sb_result result)
{
    return result == SB_ERROR_INVERTED && step->body->integrator == SB_GENERALISED_ALPHA && step->level < 1;
}

/* Tools may have made the step fail, or have passed through: they go half as far each time, then they stay, at last
 * they give way. Guests that were left behind want a shorter step, by their caller. */
static int sbi_step_can_touch_less(const sbi_step *step, sb_result result)
{
    int most = step->touch_begun && step->touch->is_last ? SBI_STEP_STOP : SBI_STEP_TRIES;
    return result != SB_OK && step->touch_begun && !step->touch->apart && !step->guests_lag && step->tries < most;
}

SBI_API int sbi_step_begin_again(sbi_step *step, sb_result *result)
{
    sbi_step fresh;
    int wider = *result != SB_OK && step->touch_begun && step->touch->missed && !step->wide;
    int later = !wider && sbi_step_can_balance_later(step, *result), less = sbi_step_can_touch_less(step, *result);
    if (!wider && !later && !less)
        return 0;
    memset(&fresh, 0, sizeof fresh);
    sbi_step_undo_guests(step);
    sbi_step_undo_touch(step);
    fresh.tries = step->tries + (later || wider ? 0 : 1);
    fresh.wide = step->wide || wider;
    fresh.begun = step->begun;
    fresh.own_info = step->own_info;
    fresh.guests = fresh.given = step->given;
    sbi_step_set_up(&fresh, step->body, step->dt, step->info);
    fresh.radius = later ? 0 : step->radius;
    fresh.part = step->part;
    fresh.patience = step->patience;
    *step = fresh;
    sbi_step_restore(step->body);
    sbi_step_watch_folds(step->body, step->linearised);
    *result = sbi_step_take_guests(step, step->given.list, step->given.count);
    if (*result == SB_OK)
        *result = sbi_step_start(step);
    return 1;
}

SBI_API sb_result sbi_step_undo(sbi_step *step, sb_result result)
{
    if (!step->body) /* refused at once */
        return result;
    sbi_step_undo_guests(step);
    sbi_step_undo_touch(step);
    sbi_step_restore(step->body);
    return sbi_step_close(step, result);
}

/* Substeps of central differences; what goes bad is done again with more caution, which stays for a while. */
static sb_result sbi_step_run_explicit(sb_body *body, sb_real dt, sb_step_info *info)
{
    sbi_step_guard guard = body->guard;
    sbi_touch *touch = body->touch;
    if (touch && !touch->keep(touch->user, NULL))
        return sbi_fail(&info->error, SB_ERROR_MEMORY, "no memory for contact on a mesh that has changed");
    for (int caution = guard.caution;; caution++) {
        sb_result result;
        sbi_step_dead_loads(body);
        sbi_live_add_light_pushes(body, dt, body->external);
        result = sbi_explicit_run(body, dt, caution, info);
        if (result == SB_OK) {
            sbi_explicit_calm(body, caution);
            return result;
        }
        sbi_step_restore(body);
        sbi_step_watch_folds(body, 0);
        body->guard = guard;
        if (touch) {
            sbi_body_update_positions(body);
            touch->undo(touch->user);
            (void)touch->rewind(touch->user, NULL); /* the mesh is the same */
        }
        if (caution == SBI_EXPLICIT_CAUTION || (result != SB_ERROR_INVERTED && result != SB_ERROR_DIVERGED))
            return result;
    }
}

static sb_result sbi_step_explicit(sb_body *body, sb_real dt, sb_step_info *info)
{
    sbi_step step;
    sb_result result = sbi_step_open(body, dt, info, &step);
    if (result == SB_OK)
        result = sbi_step_run_explicit(body, dt, step.info);
    if (result != SB_OK)
        return sbi_step_undo(&step, result);
    sbi_step_settle(&step);
    return sbi_step_close(&step, SB_OK);
}

SBI_API sb_result sbi_step_whole(sb_body *body, sb_real dt, const sbi_guest *const *guests, int guest_count,
                                 sb_real part, int patience, sb_step_info *info)
{
    sbi_step step;
    sb_result result;
    if (body && body->integrator == SB_CENTRAL_DIFFERENCE && guest_count == 0)
        return sbi_step_explicit(body, dt, info);
    result = sbi_step_begin_part(body, dt, guests, guest_count, part, patience, info, &step);
    do {
        result = sbi_step_iterate(&step, result);
        if (result == SB_OK)
            result = sbi_step_commit(&step);
    } while (sbi_step_begin_again(&step, &result));
    return result == SB_OK ? result : sbi_step_undo(&step, result);
}
