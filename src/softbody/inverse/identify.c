/* identify: checks, memory, and the iteration of Levenberg and Marquardt. */
#include "identify.h"

#include <math.h>
#include <string.h>

#include "identify_private.h"

#define SBI_IDENTIFY_COOKIE 0x1de27u

SB_API sb_identify_def sb_default_identify_def(void)
{
    sb_identify_def def;
    memset(&def, 0, sizeof def);
    def.state_count = 1;
    def.max_iterations = 50;
    def.statics = sb_default_static_options();
    def.statics.tolerance = sb_max((sb_real)1e-9, 100 * SB_EPSILON);
    def.statics.forces_only = 1;
    def.cookie = SBI_IDENTIFY_COOKIE;
    return def;
}

/* ---- checks ---- */

static sb_result sbi_identify_check_parameter(const sb_identify_def *def, int k, sb_error *error)
{
    const sb_parameter *p = def->parameters + k;
    sb_result result = sbi_parameter_check(def->body, p, k, error);
    if (result != SB_OK)
        return result;
    if (p->kind == SB_PARAMETER_TARGET || p->kind == SB_PARAMETER_SUPPORT ||
        (p->kind == SB_PARAMETER_STIFFNESS && p->row != SB_AUTO))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "parameter %d: points, supports and single rows are not sought",
                        k);
    for (int j = 0; j < k; j++) {
        const sb_parameter *other = def->parameters + j;
        int mine = p->kind == SB_PARAMETER_CONSTANT, theirs = other->kind == SB_PARAMETER_CONSTANT;
        if (p->kind <= SB_PARAMETER_CONSTANT && other->kind <= SB_PARAMETER_CONSTANT && p->region == other->region &&
            (mine != theirs || (mine && p->constant == other->constant) || (!mine && p->kind == other->kind)))
            return sbi_fail(error, SB_ERROR_ARGUMENT,
                            "parameters %d and %d are of one region: moduli, or constants, each once", j, k);
    }
    return SB_OK;
}

/* Counts the readings of a state. */
static sb_result sbi_identify_check_state(const sb_identify_def *def, int state, int *readings, sb_error *error)
{
    const sb_measurement *m = def->measurements + state;
    int nodes = def->body->domain.node_count, points = m->rows ? m->rows->row_count : 0;
    if (m->force_count < 0 || (m->force_count > 0 && (!m->force_nodes || !(m->sigma_force > 0))) || points < 0 ||
        (points > 0 && (!m->points || !m->rows->row_start || !m->rows->nodes || !m->rows->weights ||
                        !(m->sigma_point > 0) || m->rows->row_start[0] != 0)))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "measurement %d lacks an array or a sigma > 0", state);
    for (int k = 0; k < m->force_count; k++)
        if (m->force_nodes[k] < 0 || m->force_nodes[k] >= nodes)
            return sbi_fail_node(error, SB_ERROR_INDEX, m->force_nodes[k], "measurement %d: there is no node %d", state,
                                 m->force_nodes[k]);
    for (int j = 0; j < points; j++) {
        if (m->rows->row_start[j + 1] <= m->rows->row_start[j])
            return sbi_fail(error, SB_ERROR_ARGUMENT, "measurement %d: row %d is empty", state, j);
        for (int k = m->rows->row_start[j]; k < m->rows->row_start[j + 1]; k++)
            if (m->rows->nodes[k] < 0 || m->rows->nodes[k] >= nodes || !sb_is_finite(m->rows->weights[k]))
                return sbi_fail(error, SB_ERROR_INDEX, "measurement %d: row %d has a node or weight that is none",
                                state, j);
        *readings += !isnan(m->points[j].x) + !isnan(m->points[j].y) + !isnan(m->points[j].z);
        if (isinf(m->points[j].x) || isinf(m->points[j].y) || isinf(m->points[j].z))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "measurement %d: point %d is infinite", state, j);
    }
    if (m->force_count > 0)
        *readings += !isnan(m->force.x) + !isnan(m->force.y) + !isnan(m->force.z);
    if (m->force_count > 0 && (isinf(m->force.x) || isinf(m->force.y) || isinf(m->force.z)))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "measurement %d: the force is infinite", state);
    return SB_OK;
}

static sb_result sbi_identify_check_start(const sbi_identify *id, const sb_real *values, sb_error *error)
{
    const sb_identify_def *def = id->def;
    for (int k = 0; k < id->count; k++) {
        int way = sbi_identify_way(id, k);
        if (!sb_is_finite(values[k]) || (way > 0 && !(values[k] > 0)) || (way == 2 && !(values[k] < (sb_real)0.5)))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "value %d starts at %g, out of its range", k, (double)values[k]);
        if ((def->low && !(def->low[k] <= values[k])) || (def->high && !(def->high[k] >= values[k])))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "value %d starts at %g, outside its bounds", k,
                            (double)values[k]);
    }
    return SB_OK;
}

static sb_result sbi_identify_check(const sb_identify_def *def, const sb_real *values, int *readings, sb_error *error)
{
    const int most = 1 << 16;
    sb_result result = SB_OK;
    if (!def || def->cookie != SBI_IDENTIFY_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by sb_default_identify_def");
    if (!def->body || !values || !def->measurements || def->state_count < 1 || def->state_count > most ||
        def->max_iterations < 1 || def->count < 0 || def->free_count < 0 || def->count > most ||
        def->free_count > most || def->count + def->free_count < 1 || (def->count > 0 && !def->parameters) ||
        (!def->apply && (def->state_count > 1 || def->free_count > 0)))
        return sbi_fail(
            error, SB_ERROR_ARGUMENT,
            "an identification needs a body, values, measurements, something to seek, and apply for several "
            "states or free values");
    for (int k = 0; k < def->count && result == SB_OK; k++)
        result = sbi_identify_check_parameter(def, k, error);
    for (int s = 0; s < def->state_count && result == SB_OK; s++)
        result = sbi_identify_check_state(def, s, readings, error);
    if (result == SB_OK && *readings < def->count + def->free_count)
        return sbi_fail(error, SB_ERROR_INDEFINITE, "%d readings cannot tell %d values", *readings,
                        def->count + def->free_count);
    return result;
}

/* ---- memory ---- */

static void sbi_identify_layout(sbi_identify *id, sbi_arena *arena)
{
    size_t p = (size_t)id->count, m = (size_t)id->readings, n = (size_t)id->nodes;
    size_t states = (size_t)id->def->state_count, exact = (size_t)id->def->count;
    id->values = (sb_real *)sbi_arena_take(arena, p, sizeof(sb_real));
    id->trial = (sb_real *)sbi_arena_take(arena, 2 * p, sizeof(sb_real));
    id->misfit = (double *)sbi_arena_take(arena, m, sizeof(double));
    id->new_misfit = (double *)sbi_arena_take(arena, 2 * m, sizeof(double));
    id->slopes = (double *)sbi_arena_take(arena, m, p * sizeof(double));
    id->new_slopes = (double *)sbi_arena_take(arena, m, p * sizeof(double));
    id->scale = (double *)sbi_arena_take(arena, p, sizeof(double));
    id->hessian = (double *)sbi_arena_take(arena, p, p * sizeof(double));
    id->gram = (double *)sbi_arena_take(arena, p, p * sizeof(double));
    id->vectors = (double *)sbi_arena_take(arena, p, p * sizeof(double));
    id->eigenvalues = (double *)sbi_arena_take(arena, p, sizeof(double));
    id->scratch = (double *)sbi_arena_take(arena, 2 * p, sizeof(double));
    id->step = (double *)sbi_arena_take(arena, p, sizeof(double));
    id->slope = (double *)sbi_arena_take(arena, p, sizeof(double));
    id->pull = (double *)sbi_arena_take(arena, p, sizeof(double));
    id->pinned = (unsigned char *)sbi_arena_take(arena, p, 1);
    id->shapes = (sb_vec3 *)sbi_arena_take(arena, states, n * sizeof(sb_vec3));
    id->new_shapes = (sb_vec3 *)sbi_arena_take(arena, states, n * sizeof(sb_vec3));
    id->du = (sb_vec3 *)sbi_arena_take(arena, exact, n * sizeof(sb_vec3));
    id->dreaction = (sb_vec3 *)sbi_arena_take(arena, exact, n * sizeof(sb_vec3));
    id->start = (sb_vec3 *)sbi_arena_take(arena, n, sizeof(sb_vec3));
    id->loads = (sb_real *)sbi_arena_take(arena, p, sizeof(sb_real));
    id->applied = (sb_real *)sbi_arena_take(arena, p, sizeof(sb_real));
    id->stiffness = (sb_real *)sbi_arena_take(arena, sbi_identify_rows(id->def), sizeof(sb_real));
    id->materials = (sb_material *)sbi_arena_take(arena, (size_t)id->body->material_count, sizeof(sb_material));
}

static sb_result sbi_identify_take_memory(sbi_identify *id)
{
    sbi_arena arena = {NULL, 0, 0};
    unsigned char *base;
    sbi_identify_layout(id, &arena);
    if (!arena.overflow && arena.used <= (size_t)-1 - 64)
        id->memory = sbi_alloc_zeroed(&id->body->allocator, arena.used + 64, 1);
    if (!id->memory)
        return sbi_fail(id->error, SB_ERROR_MEMORY, "no memory for %d values and %d readings", id->count, id->readings);
    base = (unsigned char *)id->memory;
    arena.base = base + (64 - (uintptr_t)base % 64) % 64;
    arena.used = 0;
    sbi_identify_layout(id, &arena);
    return SB_OK;
}

/* ---- the iteration ---- */

static double sbi_identify_cost(const sbi_identify *id, const double *misfit)
{
    double sum = 0;
    for (int i = 0; i < id->readings; i++)
        sum += misfit[i] * misfit[i];
    return sum;
}

/* What was evaluated last becomes what is accepted. */
static void sbi_identify_accept(sbi_identify *id, const sb_real *values)
{
    size_t m = (size_t)id->readings, p = (size_t)id->count;
    memmove(id->values, values, p * sizeof *values);
    memcpy(id->misfit, id->new_misfit, m * sizeof *id->misfit);
    memcpy(id->slopes, id->new_slopes, m * p * sizeof *id->slopes);
    memcpy(id->shapes, id->new_shapes, (size_t)id->def->state_count * (size_t)id->nodes * sizeof *id->shapes);
    id->info.chi2 = sbi_identify_cost(id, id->misfit);
}

/* Values at a bound that chi2 falls beyond stay. */
static void sbi_identify_pin(sbi_identify *id)
{
    for (int k = 0; k < id->count; k++) {
        int side = id->slope[k] < 0 ? 1 : -1;
        id->pinned[k] = sbi_identify_room(id, k, (double)id->values[k], side) * side <= 0;
        id->step[k] = 0;
    }
}

/* pull = -J^T misfit and what steps of pinned values add to it, by the scale; 0 for pinned values. */
static void sbi_identify_pull(sbi_identify *id)
{
    int n = id->count;
    for (int a = 0; a < n; a++) {
        double sum = -id->slope[a] / id->scale[a];
        for (int b = 0; b < n && !id->pinned[a]; b++)
            if (id->pinned[b])
                sum -= id->hessian[(size_t)sbi_max_int(a, b) * (size_t)n + (size_t)sbi_min_int(a, b)] * id->scale[b] *
                       id->step[b];
        id->pull[a] = id->pinned[a] ? 0 : sum;
    }
}

/* (H + l diag H) step = pull for values that are not pinned. Returns pull . H^-1 pull. */
static double sbi_identify_solve_step(sbi_identify *id, double damping)
{
    size_t n = (size_t)id->count;
    double fall = 0;
    sbi_identify_pull(id);
    for (size_t a = 0; a < n; a++)
        id->step[a] = id->pinned[a] ? id->step[a] : 0;
    for (size_t i = 0; i < n; i++) {
        const double *z = id->vectors + i * n;
        double along = 0, stiffness = fmax(id->eigenvalues[i], 0);
        for (size_t a = 0; a < n; a++)
            along += z[a] * id->pull[a];
        for (size_t a = 0; a < n; a++)
            id->step[a] += id->pinned[a] ? 0 : along * z[a] / (stiffness + damping) / id->scale[a];
        fall += along * along / (stiffness + 1e-12);
    }
    return fall;
}

/* How far a step may lead on that side: to a bound, and not further than 1 along what goes by its logarithm. */
static double sbi_identify_reach(const sbi_identify *id, int k, int side)
{
    double room = sbi_identify_room(id, k, (double)id->values[k], side);
    return sbi_identify_way(id, k) > 0 ? side * fmin(room * side, 1) : room;
}

/* Pins values whose step leads too far there. Returns how many. */
static int sbi_identify_stop(sbi_identify *id)
{
    int stopped = 0;
    for (int k = 0; k < id->count; k++) {
        int side = id->step[k] > 0 ? 1 : -1;
        double reach = sbi_identify_reach(id, k, side);
        if (id->pinned[k] || (id->step[k] - reach) * side <= 0)
            continue;
        id->step[k] = reach;
        id->pinned[k] = 1;
        stopped++;
    }
    return stopped;
}

/* step = -(H + l diag H)^-1 J^T misfit; where it leads too far for some values, these go as far as they may, and the
 * others answer that. Returns how much chi2 should fall without damping where none does: J^T misfit . H^-1 J^T misfit.
 */
static double sbi_identify_step(sbi_identify *id, double damping)
{
    double fall;
    sbi_identify_pin(id);
    (void)sbi_identify_decompose(id);
    fall = sbi_identify_solve_step(id, damping);
    while (sbi_identify_stop(id) > 0) {
        (void)sbi_identify_decompose(id);
        (void)sbi_identify_solve_step(id, damping);
    }
    return fall;
}

/* trial = where the step leads, within bounds. Returns the most that a value moves, of itself. */
static double sbi_identify_try(sbi_identify *id, sb_real *trial)
{
    double most = 0;
    for (int k = 0; k < id->count; k++) {
        double size = fabs((double)id->values[k]);
        trial[k] = (sb_real)sbi_identify_move(id, k, (double)id->values[k], id->step[k]);
        size = fmax(size, fabs((double)trial[k]));
        if (size > 0)
            most = fmax(most, fabs((double)(trial[k] - id->values[k])) / size);
    }
    return most;
}

/* 1 where a failure says that these values will not do, and no more. */
static int sbi_identify_is_bad_trial(sb_result result)
{
    return result == SB_ERROR_NOT_CONVERGED || result == SB_ERROR_INVERTED || result == SB_ERROR_DIVERGED ||
           result == SB_ERROR_INDEFINITE || result == SB_ERROR_MATERIAL || result == SB_ERROR_NOT_FINITE;
}

/* Sum of (reading / sigma)^2. */
static double sbi_identify_size(const sbi_identify *id)
{
    double sum = 0;
    memset(id->new_misfit, 0, (size_t)id->readings * sizeof *id->new_misfit);
    sbi_identify_subtract_all(id, id->new_misfit);
    for (int i = 0; i < id->readings; i++)
        sum += id->new_misfit[i] * id->new_misfit[i];
    return sum;
}

/* What solves and rounding may leave of chi2 in readings of this size. */
static double sbi_identify_noise(const sbi_identify *id)
{
    double share = fmax((double)id->def->statics.tolerance, 100 * (double)SB_EPSILON);
    return share * share * id->size;
}

/* Tries steps until one lowers chi2. *done: there is nothing left to gain. */
static sb_result sbi_identify_improve(sbi_identify *id, double *damping, int *done)
{
    const double most = 1e10, still = SB_EPSILON > (sb_real)1e-10 ? 1e-5 : 1e-8, gain = 1e-6;
    sb_real *trial = id->trial + id->count; /* the first half is scratch of evaluations */
    double first = *damping;
    for (; *damping < most; *damping *= 10) {
        double fall = sbi_identify_step(id, *damping), moved = sbi_identify_try(id, trial), cost;
        sb_result result;
        *done = fall <= fmax(gain * id->info.chi2, sbi_identify_noise(id)) || (moved < still && *damping == first);
        if (*done)
            return SB_OK;
        result = sbi_identify_evaluate(id, trial);
        if (result != SB_OK && !sbi_identify_is_bad_trial(result))
            return result;
        cost = result == SB_OK ? sbi_identify_cost(id, id->new_misfit) : (double)INFINITY;
        if (!(cost < id->info.chi2))
            continue;
        *done = id->info.chi2 - cost <= gain * id->info.chi2;
        sbi_identify_accept(id, trial);
        *damping = fmax(*damping / 10, 1e-12);
        id->info.iterations++;
        return SB_OK;
    }
    return sbi_fail(id->error, SB_ERROR_NOT_CONVERGED, "no step lowers chi2 below %g", id->info.chi2);
}

static sb_result sbi_identify_iterate(sbi_identify *id)
{
    double damping = 1e-3;
    int done = 0;
    sb_result result = sbi_identify_evaluate(id, id->values);
    if (result != SB_OK)
        return result;
    sbi_identify_accept(id, id->values);
    id->info.start_chi2 = id->info.chi2;
    id->size = sbi_identify_size(id);
    while (!done) {
        result = sbi_identify_analyse(id);
        if (result == SB_OK && id->info.iterations >= id->def->max_iterations)
            return sbi_fail(id->error, SB_ERROR_NOT_CONVERGED, "%d steps, and chi2 %g still falls", id->info.iterations,
                            id->info.chi2);
        if (result == SB_OK)
            result = sbi_identify_improve(id, &damping, &done);
        if (result != SB_OK)
            return result;
    }
    result = sbi_identify_analyse(id);
    return result == SB_OK ? sbi_identify_check_rank(id) : result;
}

/* The body has the values, and the last state's equilibrium. */
static sb_result sbi_identify_finish(sbi_identify *id)
{
    if (id->error)
        memset(id->error, 0, sizeof *id->error);
    return sbi_identify_evaluate(id, id->values);
}

static sb_result sbi_identify_run(sbi_identify *id, sb_real *values, sb_real *deviations, sb_real *own_shares)
{
    size_t bytes = (size_t)id->nodes * sizeof *id->start;
    sb_result result;
    memcpy(id->values, values, (size_t)id->count * sizeof *values);
    sbi_identify_keep(id);
    for (int s = 0; s < id->def->state_count; s++)
        memcpy(id->shapes + (size_t)s * (size_t)id->nodes, id->start, bytes);
    result = sbi_identify_iterate(id);
    if (result == SB_OK)
        result = sbi_identify_finish(id);
    if (result != SB_OK) {
        sbi_identify_restore(id);
        return result;
    }
    sbi_identify_report(id, deviations, own_shares);
    memcpy(values, id->values, (size_t)id->count * sizeof *values);
    return SB_OK;
}

SB_API sb_result sb_identify(const sb_identify_def *def, sb_real *values, sb_real *deviations, sb_real *own_shares,
                             sb_identify_info *info, sb_error *error)
{
    sbi_identify id;
    sb_error own;
    sb_result result;
    memset(&id, 0, sizeof id);
    id.error = error ? error : &own;
    memset(id.error, 0, sizeof *id.error);
    result = sbi_identify_check(def, values, &id.readings, id.error);
    if (result != SB_OK)
        return result;
    id.def = def;
    id.body = def->body;
    id.count = def->count + def->free_count;
    id.nodes = def->body->domain.node_count;
    result = sbi_identify_check_start(&id, values, id.error);
    if (result == SB_OK)
        result = sbi_identify_take_memory(&id);
    if (result != SB_OK)
        return result;
    id.info.readings = id.readings;
    result = sbi_identify_run(&id, values, deviations, own_shares);
    sbi_free(&id.body->allocator, id.memory);
    if (result == SB_OK && info)
        *info = id.info;
    return result;
}
