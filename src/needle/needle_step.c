/* needle_step: one step of a body and its needles. Sleeves are moved and fed, one linear system gives the motion of
 * all, the remesher follows the tips, and the rods' nodes follow the remesher. */
#include "couple_solve.h"
#include "needle_private.h"

#include "../softbody/body/body_guest.h"

#include <string.h>

static double ndli_step_now(const struct ndli_site *site) { return sbi_body_now(site->body); }

/* ---- a substep ---- */

typedef struct ndli_stepping {
    struct ndli_site *site;
    ndl_needle *const *needles;
    const ndl_command *commands;
    int count;
    ndli_line *lines[NDL_MAX_NEEDLES];
    int patience; /* see sbi_step_part */
    int unmoved;  /* the needle whose rod found no motion in the substep last tried, or -1 */
    ndl_step_info *info;
    sb_error *error;
} ndli_stepping;

/* Which part of the step a substep is. */
typedef struct ndli_part {
    sb_real begin, end; /* of the step, as shares of it */
    double left;        /* its share of what is left of the step */
} ndli_part;

static void ndli_step_note_solve(ndl_step_info *info, const ndl_couple_info *couple)
{
    info->trials = sbi_max_int(info->trials, couple->trials);
    info->consistent = info->consistent && couple->consistent;
    info->iterations += info->body.pcg_iterations;
    info->capped = info->capped || info->body.capped;
    info->residual = sb_max(info->residual, info->body.residual);
}

static int ndli_step_max_trials(const ndli_stepping *s)
{
    int most = 1;
    for (int k = 0; k < s->count; k++)
        most = sbi_max_int(most, s->needles[k]->max_trials);
    return most;
}

/* What the sleeve has to exert: the balance of the nodes in it, and the frame's torque. */
static void ndli_step_read_base(ndl_needle *needle)
{
    ndl_rod *rod = needle->rod;
    const ndli_v3 *r = needle->line.reaction;
    ndli_v3 arm = ndli_sub(rod->x[0], rod->x[1]);
    needle->base_force = ndli_add(r[0], r[1]);
    ndli_rod_set_shape(rod, rod->x, rod->theta);
    ndli_rod_derivatives(rod, 0, rod->gradient, rod->turn_gradient, NULL);
    needle->base_torque = ndli_madd(ndli_cross(arm, r[0]), rod->turn_gradient[0], rod->tangent[0]);
}

/* A tip that goes back stays ahead of the node before it; in a step it gets no further than where its last edge began.
 * edge: the one before the motion. */
static void ndli_step_keep_tip_ahead(ndl_needle *needle, ndli_v3 edge)
{
    ndl_rod *rod = needle->rod;
    int last = rod->node_count - 1;
    ndli_v3 now = ndli_sub(rod->x[last], rod->x[last - 1]);
    if (needle->line.slip[ndli_line_foremost(&needle->line)] < 0 && ndli_dot(now, edge) < 0.1 * ndli_dot(edge, edge))
        rod->x[last] = ndli_madd(rod->x[last - 1], 0.1, edge);
}

/* Largest strain of an edge. */
static double ndli_step_strain(const ndl_rod *rod)
{
    double most = 0;
    for (int j = 0; j + 1 < rod->node_count; j++)
        most = fmax(most, fabs(ndli_norm(ndli_sub(rod->x[j + 1], rod->x[j])) / rod->rest_length[j] - 1));
    return most;
}

/* Linear equations stretch edges that they turn far; needles break at such strains. */
static const double ndli_step_most_strain = 0.01;

/* As the linear system has found it. Returns -1, or the node at which the rod would fold. */
static int ndli_step_move_linear(ndl_needle *needle, double dt)
{
    ndl_rod *rod = needle->rod;
    const ndli_v3 *move = needle->line.move;
    ndli_v3 edge = ndli_sub(rod->x[rod->node_count - 1], rod->x[rod->node_count - 2]);
    for (int i = 0; i < rod->node_count; i++) {
        rod->x[i] = rod->held[i] ? rod->target[i] : ndli_add(rod->x[i], move[i]);
        rod->v[i] = ndli_scale(1 / dt, move[i]);
        rod->a[i] = ndli_v(0, 0, 0);
    }
    ndli_step_keep_tip_ahead(needle, edge);
    return ndli_rod_moved(rod);
}

/* Newton's method for the nodes outside, those in the tissue where the linear system has them; from the state before.
 * 0: not found. */
static int ndli_step_move_nonlinear(ndl_needle *needle, double dt)
{
    ndl_rod *rod = needle->rod;
    const ndli_line *line = &needle->line;
    int done;
    for (int i = ndli_line_rearmost(line); i <= ndli_line_foremost(line); i++) {
        rod->held[i] = 1;
        rod->has_velocity[i] = 0;
        rod->target[i] = ndli_add(rod->x[i], line->move[i]);
    }
    done = ndli_rod_step_euler(rod, dt);
    for (int i = ndli_line_rearmost(line); i <= ndli_line_foremost(line); i++)
        rod->held[i] = i < 2;
    for (int i = 0; i < 2 && done; i++)
        line->reaction[i] = rod->reaction[i];
    return done;
}

static sb_result ndli_step_move_rod(ndl_needle *needle, double dt, sb_error *error)
{
    ndl_rod *rod = needle->rod;
    double before = ndli_step_strain(rod);
    int linear = needle->line.count > 0; /* alone, a rod needs no linear system */
    if (linear) {
        ndli_rod_save(rod);
        linear = ndli_step_move_linear(needle, dt) < 0 && ndli_step_strain(rod) <= before + ndli_step_most_strain;
        if (!linear)
            ndli_rod_restore(rod);
    }
    if (!linear && (needle->line.count > 0 || !ndli_step_move_nonlinear(needle, dt)))
        return sbi_fail(error, SB_ERROR_DIVERGED, "needle %d: no motion of the rod was found", needle->index);
    ndli_step_read_base(needle);
    return SB_OK;
}

/* The rod's nodes on those of the path. */
static sb_result ndli_step_renew(ndl_needle *needle, sb_error *error)
{
    int bad = ndli_needle_renew_nodes(needle);
    if (bad < 0)
        return SB_OK;
    if (bad >= needle->rod->capacity)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "needle %d: its capacity of %d nodes is too little for what is in the tissue", needle->index,
                        needle->rod->capacity);
    return sbi_fail_node(error, SB_ERROR_DIVERGED, bad, "needle %d would fold at its node %d", needle->index, bad);
}

static sb_result ndli_step_follow(const ndli_stepping *s, ndl_needle *needle)
{
    ndl_remesh_info done;
    sb_result result;
    double begin = ndli_step_now(s->site), middle;
    memset(&done, 0, sizeof done);
    done.worst_quality = 1;
    if (s->site->embeds)
        ndli_held_follow_tip(needle), result = SB_OK;
    else
        result = ndli_needle_follow_tip(needle, &done, s->error);
    middle = ndli_step_now(s->site);
    s->info->seconds_remesh += middle - begin;
    s->info->operations += done.substeps;
    s->info->worst_quality = sb_min(s->info->worst_quality, done.worst_quality);
    if (result != SB_OK)
        return result;
    result = ndli_step_renew(needle, s->error);
    s->info->seconds_needle += ndli_step_now(s->site) - middle;
    return result;
}

static sb_result ndli_step_prepare(const ndli_stepping *s, double dt, double share)
{
    static const ndl_command none = {0, 0, {0, 0, 0}, {0, 0, 0}};
    double begin = ndli_step_now(s->site);
    ndli_held_forget(s->site);
    for (int k = 0; k < s->count; k++) {
        ndl_needle *needle = s->needles[k];
        sb_result result = ndli_needle_is_threaded(needle) ? SB_OK : ndli_step_renew(needle, s->error);
        if (result != SB_OK)
            return result;
        ndli_bevel_begin(needle);
        ndli_needle_aim(needle, s->commands ? s->commands + k : &none, dt, share);
        if (s->site->embeds)
            ndli_held_resist(needle);
        else
            ndli_needle_resist(needle);
        needle->hold_steps = sbi_max_int(0, needle->hold_steps - 1);
    }
    s->info->seconds_needle += ndli_step_now(s->site) - begin;
    return SB_OK;
}

/* One step of the body with the rods as its guest; then the rods move as was found. What has moved when that fails the
 * whole step's undo takes back. */
static sb_result ndli_step_solve(ndli_stepping *s, double dt, const ndli_part *part)
{
    struct ndli_site *site = s->site;
    double begin = ndli_step_now(site), solve;
    const sbi_guest *guests[1];
    sbi_step_part span;
    ndli_couple couple;
    sb_result result;
    if (site->embeds)
        ndli_couple_prepare_rows(&couple, s->lines, s->count, ndli_step_max_trials(s), site->unknown, site->coupled,
                                 site->coupled_count);
    else
        ndli_couple_prepare(&couple, s->lines, s->count, ndli_step_max_trials(s), site->unknown, site->coupled);
    guests[0] = &couple.guest;
    span.begin = part->begin, span.end = part->end;
    span.patience = s->patience;
    result = sbi_body_step_part(site->body, (sb_real)dt, guests, 1, &span, &s->info->body);
    solve = s->info->body.seconds_solve;
    s->info->seconds_couple += solve;
    s->info->seconds_body += ndli_step_now(site) - begin - solve;
    begin = ndli_step_now(site);
    if (result == SB_OK)
        result = ndli_couple_check(&couple, &s->info->body.error);
    for (int k = 0; k < s->count && result == SB_OK; k++) {
        result = ndli_step_move_rod(s->needles[k], dt, &s->info->body.error);
        s->unmoved = result == SB_OK ? -1 : k;
    }
    s->info->seconds_needle += ndli_step_now(site) - begin;
    if (result == SB_OK)
        ndli_step_note_solve(s->info, &couple.info);
    else if (s->error)
        *s->error = s->info->body.error;
    return result;
}

/* A substep of dt up to where the rods have moved. */
static sb_result ndli_step_advance(ndli_stepping *s, double dt, const ndli_part *part)
{
    sb_result result = ndli_step_prepare(s, dt, part->left);
    s->unmoved = -1;
    if (result == SB_OK)
        result = ndli_step_solve(s, dt, part);
    if (result == SB_OK)
        result = ndli_site_look(s->site, s->error);
    return result;
}

/* The rest of it: tips are followed. */
static sb_result ndli_step_end_substep(const ndli_stepping *s)
{
    sb_result result = SB_OK;
    for (int k = 0; k < s->count && result == SB_OK; k++)
        result = ndli_step_follow(s, s->needles[k]);
    for (int k = 0; k < s->count && result == SB_OK; k++)
        s->info->peak_base = sb_max(s->info->peak_base, (sb_real)ndli_norm(s->needles[k]->base_force));
    s->info->substeps++;
    return result;
}

/* ---- membranes within a step, and substeps that fail ---- */

/* Times the body's cap on iterations; and tries of a step that may fail before it does. */
enum { NDLI_STEP_PATIENCE = 8, NDLI_STEP_FAILURES = 24 };

/* Substeps get no shorter than that share of one: their rounding would be felt. */
static const double ndli_step_shortest = 1e-3;

/* Share of a substep of dt in which the first tip comes to where a membrane begins or ends; 1: none does. */
static double ndli_step_share_to_edge(const ndli_stepping *s, double dt)
{
    double least = 1;
    for (int k = 0; k < s->count; k++)
        least = fmin(least, ndli_needle_share_to_edge(s->needles[k], dt));
    return least < 1 - ndli_step_shortest ? fmax(least, ndli_step_shortest) : 1;
}

/* Substeps of a step, in units of the first guess of them, which are all 1 long. One that is too long for linear
 * equations, which fold a rod, or for the tissue is taken again a fourth as long; what follows it grows again. */
enum { NDLI_STEP_EDGES = 12, NDLI_FINEST = 64 };
typedef struct ndli_step_ends {
    double edge;  /* where the first tip comes to an edge of a membrane, as the last try has shown */
    double reach; /* times as far as a first try shows it: a tip that sticks before it jumps comes there later */
    int edge_count, substeps;
    int finer;     /* substeps end at multiples of 1/finer: a power of 4 up to NDLI_FINEST */
    int last_hope; /* 1: the shortest one failed; it is tried as a whole once more, and waited for */
    int failures;  /* of all substeps */
} ndli_step_ends;

static double ndli_step_end_after(const ndli_step_ends *ends, double t)
{
    double finer = ends->finer, next = (floor(t * finer) + 1) / finer;
    return ends->edge > t ? fmin(next, ends->edge) : next;
}

static ndli_part ndli_step_part(const ndli_step_ends *ends, double t, double end)
{
    ndli_part part;
    part.begin = (sb_real)(t / ends->substeps);
    part.end = (sb_real)(end / ends->substeps);
    part.left = (end - t) / (ends->substeps - t);
    return part;
}

static int ndli_step_looks_for_edges(const ndli_step_ends *ends, double t, double end)
{
    return ends->edge_count < NDLI_STEP_EDGES && end - t > 2 * ndli_step_shortest;
}

/* What a substep is taken back to: before the first the mesh is still that of the step's start. */
static sb_result ndli_step_keep_substep(const ndli_stepping *s, double t, ndli_keeping *kept)
{
    *kept = t > 0 ? NDLI_KEPT_SUBSTEP : NDLI_KEPT_STEP;
    if (*kept == NDLI_KEPT_SUBSTEP && !ndli_needle_keep(s->site, *kept))
        return sbi_fail(s->error, SB_ERROR_MEMORY, "no memory to keep the state at the start of a substep");
    return SB_OK;
}

/* What is told of a try that is taken back: as before, but for what it took. */
static void ndli_step_forget(ndl_step_info *info, const ndl_step_info *before)
{
    ndl_step_info taken = *info;
    *info = *before;
    info->iterations = taken.iterations;
    info->seconds_body = taken.seconds_body;
    info->seconds_couple = taken.seconds_couple;
    info->seconds_needle = taken.seconds_needle;
    info->seconds_remesh = taken.seconds_remesh;
}

/* 1: shorter steps may do better. */
static int ndli_step_may_be_too_long(sb_result result)
{
    return result == SB_ERROR_DIVERGED || result == SB_ERROR_INVERTED || result == SB_ERROR_INDEFINITE ||
           result == SB_ERROR_NOT_CONVERGED;
}

/* A substep failed: shorter ones. Tissue that does not let needles go their way is waited for in the shortest, and if
 * that does not help in the whole one: in long ones more iterations would but crush it. 0: nothing is left to be
 * tried. */
static int ndli_step_shorten(ndli_step_ends *ends)
{
    if (++ends->failures > NDLI_STEP_FAILURES || ends->last_hope)
        return 0;
    ends->last_hope = ends->finer == NDLI_FINEST;
    ends->finer = ends->last_hope ? 1 : 4 * ends->finer;
    return 1;
}

/* A substep to t is done: those that follow are four times as long where that is a place for them to begin. */
static void ndli_step_lengthen(ndli_step_ends *ends, double t)
{
    double longer = t * ends->finer / 4;
    if (ends->finer > 1 && longer == floor(longer))
        ends->finer /= 4;
    ends->last_hope = 0;
}

static int ndli_step_patience(const ndli_step_ends *ends)
{
    return ends->finer == NDLI_FINEST || ends->last_hope ? NDLI_STEP_PATIENCE : 1;
}

/* A substep from t on, to the first edge of a membrane that a tip runs through in it: what it has to cut is one force
 * in a substep. No mesh has followed a tip where one is taken back for that. *end: where it ends. */
static sb_result ndli_step_try_substep(ndli_stepping *s, double dt, ndli_step_ends *ends, double t, ndli_keeping kept,
                                       double *end)
{
    ndl_step_info before = *s->info;
    double reach = ends->reach;
    sb_result result = SB_OK;
    s->patience = ndli_step_patience(ends);
    while (result == SB_OK) {
        double length, share = 1;
        ndli_part part;
        *end = ndli_step_end_after(ends, t);
        length = (*end - t) * (dt / ends->substeps);
        part = ndli_step_part(ends, t, *end);
        result = ndli_step_advance(s, length, &part);
        if (result == SB_OK && ndli_step_looks_for_edges(ends, t, *end))
            share = ndli_step_share_to_edge(s, length);
        if (result != SB_OK || !(share < 1))
            break;
        ends->edge = t + fmin(share * reach, 0.5 * (1 + share)) * (*end - t);
        reach = 1;
        ends->edge_count++;
        ndli_step_forget(s->info, &before);
        result = ndli_needle_undo(s->site, kept, s->error);
    }
    ends->reach *= *end >= ends->edge && ends->edge > t ? 2 : 1;
    return result == SB_OK ? ndli_step_end_substep(s) : result;
}

/* The next substep, as long as it can be. */
static sb_result ndli_step_run_substep(ndli_stepping *s, double dt, ndli_step_ends *ends, double t, double *end)
{
    ndl_step_info before = *s->info;
    ndli_keeping kept;
    sb_result result = ndli_step_keep_substep(s, t, &kept);
    if (result == SB_OK)
        result = ndli_step_try_substep(s, dt, ends, t, kept, end);
    while (ndli_step_may_be_too_long(result) && ndli_step_shorten(ends)) {
        ndli_step_forget(s->info, &before);
        result = ndli_needle_undo(s->site, kept, s->error);
        if (result == SB_OK)
            result = ndli_step_try_substep(s, dt, ends, t, kept, end);
    }
    if (result == SB_OK)
        ndli_step_lengthen(ends, *end);
    return result;
}

/* ---- a step ---- */

static const double ndli_step_most_substeps = 1000;

/* How far a command takes a needle in the length of half an edge, and in half a radian. What is drawn in comes off the
 * edge at the sleeve, which may be no longer than that, and needs some left: it counts twice. */
static double ndli_step_stride(const ndl_needle *needle, const ndl_command *command, double dt)
{
    const ndl_rod *rod = needle->rod;
    double edge = needle->site->mean_edge, unit = 0.5 * (edge < needle->edge_length ? edge : needle->edge_length);
    double out = ndli_norm(ndli_sub(rod->x[sbi_min_int(needle->line.first, rod->node_count - 1)], needle->outlet));
    double way = 0, turn = 0;
    if (command) {
        double spin = ndli_norm(ndli_from(command->angular_velocity));
        double fed = (double)command->insertion;
        way = dt * (fmax(fed, -2 * fed) + ndli_norm(ndli_from(command->velocity)) + out * spin);
        turn = dt * (fabs((double)command->twist) + spin);
    }
    if (needle->base_given) {
        way += ndli_norm(ndli_sub(needle->given_outlet, needle->outlet)) +
               out * ndli_norm(ndli_sub(needle->given_axis, needle->axis));
        turn += ndli_norm(ndli_sub(needle->given_axis, needle->axis)) +
                fabs(ndli_needle_given_turn(needle, needle->given_axis));
    }
    return way / unit > turn / 0.5 ? way / unit : turn / 0.5;
}

static int ndli_step_is_command_finite(const ndl_command *c)
{
    return sb_is_finite(c->insertion) && sb_is_finite(c->twist) && sb_v3_is_finite(c->velocity) &&
           sb_v3_is_finite(c->angular_velocity);
}

static sb_result ndli_step_check(const struct ndli_site *site, ndl_needle *const *needles, int count, sb_real dt,
                                 const ndl_command *commands, int *substeps, sb_error *error)
{
    double most = 0;
    if (!needles || !(dt > 0) || !sb_is_finite(dt))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a step needs a body, its needles and dt > 0, not %g", (double)dt);
    if (!site || count != site->count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%d needles given, the body has %d", count, site ? site->count : 0);
    if (!site->embeds && sbi_body_has_pieces(site->body))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "the body is cut: needles cannot go through pieces of elements yet; destroy them, and go on "
                        "with sb_body_step");
    for (int k = 0; k < count; k++) {
        double stride;
        if (!needles[k] || needles[k]->site != site)
            return sbi_fail(error, SB_ERROR_ARGUMENT, "needle %d is not of this body", k);
        for (int i = 0; i < k; i++)
            if (needles[i] == needles[k])
                return sbi_fail(error, SB_ERROR_ARGUMENT, "needles %d and %d are the same", i, k);
        if (commands && !ndli_step_is_command_finite(commands + k))
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "command %d is not finite", k);
        stride = ndli_step_stride(needles[k], commands ? commands + k : NULL, (double)dt);
        most = stride > most ? stride : most;
    }
    if (!(most < ndli_step_most_substeps))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the commands would take %g substeps: too fast for a step of %g s",
                        most, (double)dt);
    *substeps = most > 1 ? (int)most + 1 : 1;
    return SB_OK;
}

static void ndli_step_count_states(const ndli_stepping *s)
{
    for (int k = 0; k < s->count; k++) {
        const ndl_needle *needle = s->needles[k];
        for (int i = ndli_line_rearmost(&needle->line); i <= ndli_line_foremost(&needle->line); i++) {
            s->info->dynamic_nodes += ndli_line_is_slipping(&needle->line, i);
            s->info->static_nodes += !ndli_line_is_slipping(&needle->line, i);
        }
        s->info->blocked += needle->blocked;
        s->info->limited += needle->limited;
        s->info->coarse += ndli_bevel_is_coarse(needle);
    }
}

static int ndli_step_let_go(ndl_needle *needle)
{
    struct ndli_site *site = needle->site;
    if (!site->embeds)
        return ndl_remesh_withdraw(site->remesh, needle->index, NULL, NULL) == SB_OK;
    ndli_held_leave(needle);
    needle->lost = NDLI_LOST_TORN;
    return 1;
}

/* One that is hardly in tears out of the skin. One whose mesh follows may have been left so far beside its path that no
 * step, however short, brings it there: from then on it would be stuck, also where it is drawn back. */
static int ndli_step_may_tear(const ndli_stepping *s, int k)
{
    const ndl_needle *needle = s->needles[k];
    if (needle->line.count == 0)
        return 0;
    return (double)ndl_needle_depth(needle) < 0.5 * s->site->mean_edge || (k == s->unmoved && !s->site->embeds);
}

/* Takes needles out when no step can be made with them. Returns how many; 0: nothing has changed; -1: no memory to take
 * back what has. */
static int ndli_step_tear_out(const ndli_stepping *s)
{
    int torn = 0;
    for (int k = 0; k < s->count; k++) {
        ndl_needle *needle = s->needles[k];
        if (!ndli_step_may_tear(s, k))
            continue;
        if (!ndli_step_let_go(needle) || ndli_needle_renew_nodes(needle) >= 0)
            return ndli_needle_undo(s->site, NDLI_KEPT_STEP, s->error) == SB_OK ? 0 : -1;
        torn++;
    }
    return torn;
}

/* In so many substeps, one more wherever a tip runs through an edge of a membrane, and more where one fails. */
static sb_result ndli_step_run(ndli_stepping *s, double dt, int substeps)
{
    ndli_step_ends ends;
    sb_result result = SB_OK;
    memset(&ends, 0, sizeof ends);
    ends.substeps = substeps;
    ends.finer = 1;
    ends.reach = 1;
    memset(s->info, 0, sizeof *s->info);
    s->info->consistent = 1;
    s->info->worst_quality = 1;
    for (double t = 0, end = 0; t < substeps && result == SB_OK; t = end)
        result = ndli_step_run_substep(s, dt, &ends, t, &end);
    if (result != SB_OK && ndli_needle_undo(s->site, NDLI_KEPT_STEP, s->error) != SB_OK)
        return SB_ERROR_MEMORY;
    return result;
}

/* A step that is sound in its arguments. */
static sb_result ndli_step_make(ndli_stepping *s, double dt, int substeps)
{
    double begin = ndli_step_now(s->site);
    sb_result result;
    for (int k = 0; k < s->count; k++) {
        s->lines[k] = &s->needles[k]->line;
        s->needles[k]->blocked = s->needles[k]->limited = 0;
    }
    result = ndli_needle_look(s->site, s->error);
    if (result != SB_OK)
        return result;
    if (!ndli_needle_keep(s->site, NDLI_KEPT_STEP))
        return sbi_fail(s->error, SB_ERROR_MEMORY, "no memory to keep the state at the start of a step");
    result = ndli_step_run(s, dt, substeps);
    if (result == SB_ERROR_DIVERGED) {
        int torn = ndli_step_tear_out(s);
        if (torn != 0)
            result = torn > 0 ? ndli_step_run(s, dt, substeps) : SB_ERROR_MEMORY;
        s->info->torn = result == SB_OK ? torn : 0;
    }
    for (int k = 0; k < s->count; k++) {
        s->needles[k]->base_given = s->needles[k]->base_given && result != SB_OK;
        ndli_rod_publish(s->needles[k]->rod);
    }
    ndli_step_count_states(s);
    s->info->seconds_total = ndli_step_now(s->site) - begin;
    return result;
}

NDL_API sb_result ndl_step(sb_body *body, ndl_needle *const *needles, int count, sb_real dt,
                           const ndl_command *commands, ndl_step_info *info, sb_error *error)
{
    ndl_step_info own;
    ndli_stepping s;
    sb_result result;
    int substeps = 1;
    s.info = info ? info : &own;
    memset(s.info, 0, sizeof *s.info);
    s.site = body ? ndli_needle_site(body) : NULL;
    result = s.site ? ndli_needle_finish_undo(s.site, error) : SB_OK; /* before needles are looked at */
    if (result == SB_OK)
        result = ndli_step_check(s.site, needles, count, dt, commands, &substeps, error);
    if (result != SB_OK)
        return result;
    s.unmoved = -1;
    s.needles = needles;
    s.commands = commands;
    s.count = count;
    s.error = error;
    sbi_body_mute(body);
    result = ndli_step_make(&s, (double)dt, substeps);
    sbi_body_unmute(body);
    ndli_needle_tell_step(s.site, needles, count, dt, commands, result);
    return result;
}

/* ---- a step of a recording ---- */

static sb_result ndli_replay_step(struct ndli_site *site, const int *ints, size_t int_count, const sb_real *reals,
                                  size_t real_count, sb_error *error)
{
    ndl_needle *needles[NDL_MAX_NEEDLES];
    ndl_command commands[NDL_MAX_NEEDLES];
    int count = ints[1];
    if (count < 0 || count > NDL_MAX_NEEDLES || int_count != 2 + (size_t)count ||
        real_count != 1 + NDLI_COMMAND_REALS * (size_t)count)
        return sbi_fail(error, SB_ERROR_FORMAT, "the recording holds a step of %d needles that is none", count);
    for (int k = 0; k < count; k++) {
        const sb_real *c = reals + 1 + NDLI_COMMAND_REALS * k;
        if (ints[2 + k] < 0 || ints[2 + k] >= NDL_MAX_NEEDLES)
            return sbi_fail(error, SB_ERROR_FORMAT, "the recording holds a step of needle %d", ints[2 + k]);
        needles[k] = site->needles[ints[2 + k]];
        commands[k].insertion = c[0], commands[k].twist = c[1];
        commands[k].velocity = sb_v3(c[2], c[3], c[4]);
        commands[k].angular_velocity = sb_v3(c[5], c[6], c[7]);
    }
    return ndl_step(site->body, needles, count, reals[0], commands, NULL, error);
}

NDLI_API sb_result ndli_needle_replay(void *user, const int *ints, size_t int_count, const sb_real *reals,
                                      size_t real_count, sb_error *error)
{
    struct ndli_site *site = (struct ndli_site *)user;
    int code = int_count >= 2 ? ints[0] : 0;
    if (code == NDLI_COMMAND_STEP)
        return ndli_replay_step(site, ints, int_count, reals, real_count, error);
    if (code == NDLI_COMMAND_BASE && real_count == 9 && ints[1] >= 0 && ints[1] < NDL_MAX_NEEDLES &&
        site->needles[ints[1]])
        return ndl_needle_move_base(site->needles[ints[1]], sb_v3(reals[0], reals[1], reals[2]),
                                    sb_v3(reals[3], reals[4], reals[5]), sb_v3(reals[6], reals[7], reals[8]));
    if (code == NDLI_COMMAND_NEEDLE_MADE || code == NDLI_COMMAND_NEEDLE_GONE)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "needle %d was %s while this was recorded: what follows cannot be "
                        "played",
                        ints[1], code == NDLI_COMMAND_NEEDLE_MADE ? "made" : "destroyed");
    return sbi_fail(error, SB_ERROR_FORMAT, "the recording holds a command of needles that there is not");
}
