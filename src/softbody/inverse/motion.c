/* motion: the adjoint of recorded steps, from the last to the first.
 *
 * A recording is played once, with its state kept at every `spacing`-th step; then stretch after stretch, the last
 * first, is played again with the state before each step kept, and walked back. */
#include "motion.h"

#include <math.h>
#include <string.h>

#include "../body/record_private.h"
#include "../body/state.h"
#include "equilibrium.h"

/* A place in the recording, and the body there. */
typedef struct sbi_motion_place {
    unsigned char *state; /* [size], or NULL */
    size_t size;
    sbi_record_cursor cursor;
    sb_recording_report report;
} sbi_motion_place;

typedef struct sbi_motion {
    sb_body *body;
    sbi_record_player player;
    sb_recording_report report;
    sb_recording_loss loss;
    const sb_parameter *parameters;
    int parameter_count, node_count, solves;
    sb_error *error;

    int steps;                              /* time steps of the recording that went well */
    int spacing;                            /* of checkpoints, in steps; as many places has a stretch */
    int stretches;                          /* checkpoints */
    sbi_motion_place before, after;         /* the call; the recording */
    sbi_motion_place *checkpoints, *places; /* [stretches]; [spacing] before each step of a stretch */
    sb_real *lengths;                       /* [spacing] of those steps (s) */
    int *numbers;                           /* [spacing] of the recording */
    sb_vec3 *ends;                          /* [spacing][node_count] displacements that they led to */

    sb_vec3 *vectors;                                          /* what the next five, [node_count] each, lie in */
    sb_vec3 *displacement_slope, *velocity_slope, *multiplier; /* U, V, l */
    sb_vec3 *residual, *product;
    double *gradient;     /* [parameter_count] */
    unsigned char *known; /* [parameter_count] 1: some step has it */
    sb_vec3 *force;       /* [solves][node_count], or NULL */
} sbi_motion;

/* ---- memory ---- */

static sb_result sbi_motion_take_memory(sbi_motion *m, int wants_forces)
{
    const sb_allocator *allocator = &m->body->allocator;
    size_t nodes = (size_t)m->node_count, spacing = (size_t)m->spacing;
    m->checkpoints = (sbi_motion_place *)sbi_alloc_zeroed(allocator, (size_t)m->stretches, sizeof *m->checkpoints);
    m->places = (sbi_motion_place *)sbi_alloc_zeroed(allocator, spacing, sizeof *m->places);
    m->lengths = (sb_real *)sbi_alloc(allocator, spacing, sizeof *m->lengths);
    m->numbers = (int *)sbi_alloc(allocator, spacing, sizeof *m->numbers);
    m->ends = (sb_vec3 *)sbi_alloc(allocator, spacing, nodes * sizeof *m->ends);
    m->vectors = (sb_vec3 *)sbi_alloc_zeroed(allocator, nodes, 5 * sizeof *m->vectors);
    m->gradient = (double *)sbi_alloc_zeroed(allocator, (size_t)m->parameter_count + 1, sizeof *m->gradient);
    m->known = (unsigned char *)sbi_alloc_zeroed(allocator, (size_t)m->parameter_count + 1, 1);
    if (wants_forces)
        m->force = (sb_vec3 *)sbi_alloc_zeroed(allocator, (size_t)m->solves, nodes * sizeof *m->force);
    if (!m->checkpoints || !m->places || !m->lengths || !m->numbers || !m->ends || !m->vectors || !m->gradient ||
        !m->known || (wants_forces && !m->force))
        return sbi_fail(m->error, SB_ERROR_MEMORY, "no memory for the gradient of %d steps", m->steps);
    m->displacement_slope = m->vectors;
    m->velocity_slope = m->displacement_slope + nodes;
    m->multiplier = m->velocity_slope + nodes;
    m->residual = m->multiplier + nodes;
    m->product = m->residual + nodes;
    return SB_OK;
}

static void sbi_motion_drop(const sbi_motion *m, sbi_motion_place *place)
{
    sbi_free(&m->body->allocator, place->state);
    memset(place, 0, sizeof *place);
}

static void sbi_motion_free(sbi_motion *m)
{
    const sb_allocator *allocator = &m->body->allocator;
    for (int i = 0; m->checkpoints && i < m->stretches; i++)
        sbi_motion_drop(m, m->checkpoints + i);
    for (int i = 0; m->places && i < m->spacing; i++)
        sbi_motion_drop(m, m->places + i);
    sbi_motion_drop(m, &m->before);
    sbi_motion_drop(m, &m->after);
    sbi_free(allocator, m->checkpoints);
    sbi_free(allocator, m->places);
    sbi_free(allocator, m->lengths);
    sbi_free(allocator, m->numbers);
    sbi_free(allocator, m->ends);
    sbi_free(allocator, m->vectors);
    sbi_free(allocator, m->gradient);
    sbi_free(allocator, m->known);
    sbi_free(allocator, m->force);
}

/* ---- places ---- */

static sb_result sbi_motion_keep(sbi_motion *m, sbi_motion_place *place)
{
    sbi_motion_drop(m, place);
    place->size = sb_body_state_size(m->body);
    place->state = (unsigned char *)sbi_alloc(&m->body->allocator, place->size, 1);
    if (!place->state)
        return sbi_fail(m->error, SB_ERROR_MEMORY, "no memory for a state of %lu bytes", (unsigned long)place->size);
    place->cursor = m->player.cursor;
    place->report = m->report;
    return sb_body_state_save(m->body, place->state, place->size);
}

static sb_result sbi_motion_go_to(sbi_motion *m, const sbi_motion_place *place)
{
    m->player.cursor = place->cursor;
    m->report = place->report;
    return sb_body_state_load(m->body, place->state, place->size, m->error);
}

/* ---- playing ---- */

static int sbi_motion_is_step(const sbi_record_glance *next)
{
    return next->code == SBI_COMMAND_STEP && next->went_well;
}

/* 1 when the call sets what steps lead to. */
static int sbi_motion_is_broken_by(const sbi_record_glance *next)
{
    switch (next->code) {
    case SBI_COMMAND_DISPLACEMENTS:
    case SBI_COMMAND_VELOCITIES:
    case SBI_COMMAND_RESET:
    case SBI_COMMAND_STATE:
    case SBI_COMMAND_PLACE:
    case SBI_COMMAND_CHANGE:
    case SBI_COMMAND_PART:
    case SBI_COMMAND_PART_STEP: return 1;
    case SBI_COMMAND_STATIC: return next->went_well;
    default: return 0;
    }
}

static sb_result sbi_motion_play(sbi_motion *m)
{
    sb_result result = sbi_record_play_next(&m->player);
    if (result != SB_OK && m->error)
        *m->error = m->report.error;
    return result;
}

/* Plays all calls before the next time step; *next is that, or there is none: 0. */
static int sbi_motion_play_to_step(sbi_motion *m, sbi_record_glance *next, sb_result *result)
{
    *result = SB_OK;
    while (*result == SB_OK && sbi_record_peek(&m->player, next)) {
        if (sbi_motion_is_step(next))
            return 1;
        if (m->steps > 0 && sbi_motion_is_broken_by(next))
            *result = sbi_fail(m->error, SB_ERROR_UNSUPPORTED,
                               "a call after step %d sets where the body is: steps from there on are another motion",
                               m->report.steps - 1);
        else
            *result = sbi_motion_play(m);
    }
    return 0;
}

static sb_result sbi_motion_check(sbi_motion *m)
{
    if (m->body->observer)
        return sbi_fail(m->error, SB_ERROR_ARGUMENT, "a recording listens to the body: stop it, or take another body");
    for (int k = 0; k < m->parameter_count; k++)
        if (m->parameters[k].kind == SB_PARAMETER_SUPPORT)
            return sbi_fail(m->error, SB_ERROR_UNSUPPORTED, "parameter %d: supports have no gradient of a motion", k);
        else if (m->parameters[k].kind == SB_PARAMETER_DENSITY && m->body->domain.cell_mass)
            return sbi_fail(m->error, SB_ERROR_UNSUPPORTED,
                            "parameter %d: elements of a grid have masses of their own beside their density", k);
    return SB_OK;
}

/* Steps of the recording, which is not played. */
static void sbi_motion_count(sbi_motion *m)
{
    sbi_record_player ahead = m->player;
    sb_recording_report report = m->report;
    sbi_record_glance next;
    int count = 0;
    ahead.report = &report;
    while (sbi_record_peek(&ahead, &next)) {
        count += sbi_motion_is_step(&next);
        sbi_record_skip(&ahead);
    }
    m->spacing = sbi_max_int(1, (int)ceil(sqrt((double)count)));
    m->stretches = sbi_max_int(1, (count + m->spacing - 1) / m->spacing);
    m->solves = sbi_max_int(1, report.steps);
}

/* Plays all of it, and keeps the states from which stretches begin. */
static sb_result sbi_motion_forward(sbi_motion *m)
{
    sbi_record_glance next;
    sb_result result;
    while (sbi_motion_play_to_step(m, &next, &result)) {
        if (m->steps % m->spacing == 0)
            result = sbi_motion_keep(m, m->checkpoints + m->steps / m->spacing);
        if (result == SB_OK)
            result = sbi_motion_play(m);
        if (result != SB_OK)
            return result;
        m->steps++;
    }
    return result;
}

/* Plays a stretch again, and keeps what it needs to be walked back; *count: its steps. */
static sb_result sbi_motion_play_stretch(sbi_motion *m, int stretch, int *count)
{
    const int end = sbi_min_int(m->spacing, m->steps - stretch * m->spacing);
    sb_result result = sbi_motion_go_to(m, m->checkpoints + stretch);
    sbi_record_glance next;
    for (*count = 0; result == SB_OK && *count < end && sbi_motion_play_to_step(m, &next, &result); ++*count) {
        m->lengths[*count] = next.dt;
        m->numbers[*count] = m->report.steps;
        result = sbi_motion_keep(m, m->places + *count);
        if (result == SB_OK)
            result = sbi_motion_play(m);
        memcpy(m->ends + (size_t)*count * (size_t)m->node_count, m->body->displacement,
               (size_t)m->node_count * sizeof(sb_vec3));
    }
    return result;
}

/* ---- walking back ---- */

/* multiplier = l of A l = dJ/du + U + V/dt. */
static sb_result sbi_motion_solve(sbi_motion *m, sbi_equilibrium *eq, int number, sb_real dt)
{
    memset(m->multiplier, 0, (size_t)m->node_count * sizeof *m->multiplier);
    m->loss.add_slope(m->loss.user, number, m->body->displacement, m->multiplier);
    for (int i = 0; i < m->node_count; i++) {
        if (!sb_v3_is_finite(m->multiplier[i]))
            return sbi_fail_node(m->error, SB_ERROR_NOT_FINITE, i, "dj_du of node %d in step %d is not finite", i,
                                 number);
        m->multiplier[i] =
            sb_v3_madd(sb_v3_add(m->multiplier[i], m->displacement_slope[i]), 1 / dt, m->velocity_slope[i]);
    }
    return sbi_equilibrium_solve(eq, 1, 1, m->multiplier);
}

/* Parameters' part of the step, of the loads that are there. */
static void sbi_motion_add_parameters(sbi_motion *m, sbi_equilibrium *eq)
{
    const sb_body *b = m->body;
    sb_real beta = sbi_body_has_beta(b) ? sbi_step_beta(b) : 0;
    for (int i = 0; i < m->node_count; i++)
        m->product[i] = sb_v3_madd(b->displacement[i], beta, sbi_step_velocity(&eq->step, i));
    eq->strain = m->product;
    for (int k = 0; k < m->parameter_count; k++) {
        double sum = 0;
        if (sbi_parameter_check(b, m->parameters + k, k, NULL) != SB_OK)
            continue;
        sbi_parameter_residual(eq, m->parameters + k, m->residual);
        for (int i = 0; i < m->node_count; i++)
            sum += (double)sb_v3_dot(m->multiplier[i], m->residual[i]);
        m->gradient[k] -= sum;
        m->known[k] = 1;
    }
}

/* U and V of the step before. */
static void sbi_motion_step_back(sbi_motion *m, const sbi_equilibrium *eq, sb_real dt)
{
    const sb_body *b = m->body;
    sb_real alpha = sbi_step_alpha(b);
    sbi_body_mass_multiply(b, m->multiplier, m->product);
    memset(m->residual, 0, (size_t)m->node_count * sizeof *m->residual);
    if (sbi_body_has_beta(b))
        sbi_step_damping_product(&eq->step, m->multiplier, m->residual);
    for (int i = 0; i < m->node_count; i++) {
        sb_vec3 damped = sb_v3_madd(sb_v3_scale(alpha, m->product[i]), sbi_step_beta(b), m->residual[i]);
        sb_vec3 inertia = sb_v3_scale(1 / dt, m->product[i]);
        sb_vec3 slope = sb_v3_sub(sb_v3_add(inertia, damped), m->velocity_slope[i]);
        m->displacement_slope[i] = sb_v3_scale(1 / dt, slope);
        m->velocity_slope[i] = inertia;
    }
}

/* An error of a step, by its number. */
static sb_result sbi_motion_name(const sbi_motion *m, int number, sb_result result)
{
    sb_error was;
    if (!m->error)
        return result;
    was = *m->error;
    sbi_fail(m->error, result, "step %d: %.200s", number, was.message);
    m->error->node = was.node;
    m->error->element = was.element;
    return result;
}

static sb_result sbi_motion_walk_step(sbi_motion *m, int k)
{
    const sb_vec3 *end = m->ends + (size_t)k * (size_t)m->node_count;
    sb_real dt = m->lengths[k];
    sbi_equilibrium eq;
    sb_result result = sbi_motion_go_to(m, m->places + k);
    if (result == SB_OK)
        result = sbi_equilibrium_begin_step(m->body, dt, end, sb_max((sb_real)1e-10, 100 * SB_EPSILON), &eq, m->error);
    if (result != SB_OK)
        return sbi_motion_name(m, m->numbers[k], result);
    result = sbi_motion_solve(m, &eq, m->numbers[k], dt);
    if (result == SB_OK) {
        sbi_motion_add_parameters(m, &eq);
        if (m->force)
            memcpy(m->force + (size_t)m->numbers[k] * (size_t)m->node_count, m->multiplier,
                   (size_t)m->node_count * sizeof *m->force);
        sbi_motion_step_back(m, &eq, dt);
    }
    sbi_equilibrium_end(&eq);
    return result;
}

static sb_result sbi_motion_backward(sbi_motion *m)
{
    sb_result result = SB_OK;
    for (int stretch = (m->steps - 1) / m->spacing; result == SB_OK && stretch >= 0; stretch--) {
        int count = 0;
        result = sbi_motion_play_stretch(m, stretch, &count);
        for (int k = count - 1; result == SB_OK && k >= 0; k--)
            result = sbi_motion_walk_step(m, k);
    }
    return result;
}

/* ---- all of it ---- */

/* What no step has is no parameter. */
static sb_result sbi_motion_check_known(const sbi_motion *m)
{
    for (int k = 0; m->steps > 0 && k < m->parameter_count; k++) {
        sb_result result = m->known[k] ? SB_OK : sbi_parameter_check(m->body, m->parameters + k, k, m->error);
        if (result != SB_OK)
            return result;
    }
    return SB_OK;
}

static sb_result sbi_motion_run(sbi_motion *m, int wants_forces)
{
    sb_result result;
    sbi_motion_count(m);
    result = sbi_motion_take_memory(m, wants_forces);
    if (result == SB_OK)
        result = sbi_motion_forward(m);
    if (result == SB_OK)
        result = sbi_motion_keep(m, &m->after);
    if (result == SB_OK)
        result = sbi_motion_backward(m);
    if (result == SB_OK)
        result = sbi_motion_go_to(m, &m->after);
    return result == SB_OK ? sbi_motion_check_known(m) : result;
}

static sb_result sbi_motion_check_results(const sbi_motion *m)
{
    for (int k = 0; k < m->parameter_count; k++)
        if (!sb_is_finite((sb_real)m->gradient[k]))
            return sbi_fail(m->error, SB_ERROR_NOT_FINITE, "the derivative by parameter %d is not finite", k);
    for (int i = 0; i < m->node_count; i++)
        if (!sb_v3_is_finite(m->displacement_slope[i]) || !sb_v3_is_finite(m->velocity_slope[i]))
            return sbi_fail_node(m->error, SB_ERROR_NOT_FINITE, i, "the derivative by node %d is not finite", i);
    return SB_OK;
}

static void sbi_motion_give(const sbi_motion *m, const sb_recording_slopes *slopes)
{
    size_t vectors = (size_t)m->node_count * sizeof(sb_vec3);
    for (int k = 0; slopes->gradient && k < m->parameter_count; k++)
        slopes->gradient[k] = (sb_real)m->gradient[k];
    if (slopes->displacement)
        memcpy(slopes->displacement, m->displacement_slope, vectors);
    if (slopes->velocity)
        memcpy(slopes->velocity, m->velocity_slope, vectors);
    if (slopes->force)
        memcpy(slopes->force, m->force, (size_t)m->report.steps * vectors);
}

SB_API sb_result sb_recording_gradient(const sb_recording *recording, sb_body *body, const sb_recording_loss *loss,
                                       const sb_parameter *parameters, int parameter_count,
                                       const sb_recording_slopes *slopes, sb_error *error)
{
    sbi_motion m;
    sb_result result;
    if (!recording || !body || !loss || !loss->add_slope || !slopes || parameter_count < 0 ||
        (parameter_count > 0 && !parameters))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a gradient needs a recording, a body, a loss and parameters");
    memset(&m, 0, sizeof m);
    m.body = body;
    m.loss = *loss;
    m.parameters = parameters;
    m.parameter_count = parameter_count;
    m.node_count = body->domain.node_count;
    m.error = error;
    result = sbi_motion_check(&m);
    if (result == SB_OK)
        result = sbi_motion_keep(&m, &m.before);
    if (result == SB_OK) {
        result = sbi_record_open(recording, body, &m.report, &m.player);
        if (result != SB_OK && error)
            *error = m.report.error;
        if (result == SB_OK) {
            result = sbi_motion_run(&m, slopes->force != NULL);
            sbi_record_close(&m.player);
        }
        if (result == SB_OK)
            result = sbi_motion_check_results(&m);
        if (result != SB_OK)
            (void)sb_body_state_load(body, m.before.state, m.before.size, NULL);
    }
    if (result == SB_OK)
        sbi_motion_give(&m, slopes);
    sbi_motion_free(&m);
    return result;
}
