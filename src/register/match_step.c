/* match_step: one step of a match: look at the target, pull, solve, raise the charge. */
#include <string.h>

#include "match_private.h"

static double regi_match_now(const reg_match *match) { return match->clock ? match->clock() : 0.0; }

REGI_API const int *regi_match_nodes(const reg_match *match, int charge)
{
    return match->mesh.elements + (size_t)match->charges[charge].element * (size_t)match->width;
}

REGI_API sb_vec3 regi_match_point(const reg_match *match, int charge)
{
    const int *nodes = regi_match_nodes(match, charge);
    const sb_real *weights = match->weights + (size_t)charge * (size_t)match->width;
    sb_vec3 x = sb_v3(0, 0, 0);
    for (int a = 0; a < match->width; a++)
        x = sb_v3_madd(x, weights[a], sb_v3_add(match->mesh.nodes[nodes[a]], match->shape[nodes[a]]));
    return x;
}

/* ---- looking at the target ---- */

/* The outward normal now: cof(F) N. Where the element is flat, the one at rest. */
static sb_vec3 regi_match_normal(const reg_match *match, int charge)
{
    const int *nodes = regi_match_nodes(match, charge);
    const sb_vec3 *gradients = match->gradients + (size_t)charge * (size_t)match->width;
    sb_vec3 rest = match->charges[charge].normal, r[3], normal;
    sb_mat3 f = sb_m3_zero();
    sb_real length;
    for (int a = 0; a < match->width; a++)
        f = sb_m3_add(f, sb_m3_outer(sb_v3_add(match->mesh.nodes[nodes[a]], match->shape[nodes[a]]), gradients[a]));
    for (int c = 0; c < 3; c++)
        r[c] = sb_v3(f.m[0][c], f.m[1][c], f.m[2][c]);
    normal = sb_v3_scale(rest.x, sb_v3_cross(r[1], r[2]));
    normal = sb_v3_madd(normal, rest.y, sb_v3_cross(r[2], r[0]));
    normal = sb_v3_madd(normal, rest.z, sb_v3_cross(r[0], r[1]));
    length = sb_v3_norm(normal);
    return length > 0 ? sb_v3_scale((sb_real)1 / length, normal) : rest;
}

/* Distance potential, rounded off within r of the target: phi' = d/r there and 1 beyond, along the normal of the target
 * (of the organ, when the target's is not known). Beyond, its own second derivative is 0; 1/d in its place is the
 * curvature of the parabola that touches it from above, so that a step never goes too far. */
static void regi_match_feel_distance(const reg_match *match, regi_match_charge *charge, const reg_field_hit *hit,
                                     sb_vec3 normal)
{
    sb_real r = match->rounding, d, size;
    charge->line = sb_v3_dot(hit->normal, hit->normal) > 0 ? hit->normal : normal;
    d = sb_v3_dot(sb_v3_sub(charge->point, hit->point), charge->line);
    size = sb_abs(d);
    charge->stiffness = 1 / sb_max(r, size);
    charge->force = sb_v3_scale(d * charge->stiffness, charge->line);
    charge->energy = size < r ? (sb_real)0.5 * d * d / r : size - (sb_real)0.5 * r;
}

/* Laplace's: the slope along the organ's normal. What the grid's gradient has across it is noise of the cells, against
 * which nothing would hold the charge. */
static int regi_match_feel_grid(const reg_match *match, regi_match_charge *charge, sb_vec3 normal)
{
    reg_field_sample sample;
    if (!reg_field_along(match->field, charge->point, normal, 2 * match->rounding, -1, &sample))
        return 0;
    charge->line = normal;
    charge->energy = sample.phi;
    charge->force = sb_v3_scale(sample.phi_n, normal);
    charge->stiffness = sb_max(sample.phi_nn, sb_abs(sample.phi_n) / sb_max(match->rounding, charge->distance));
    return 1;
}

static void regi_match_look_at(reg_match *match, int index)
{
    regi_match_charge *charge = match->charges + index;
    sb_vec3 normal = regi_match_normal(match, index);
    reg_field_hit hit;
    charge->point = regi_match_point(match, index);
    charge->active = reg_field_closest(match->field, charge->point, charge->guess, &hit);
    if (!charge->active)
        return;
    charge->guess = hit.item;
    charge->distance = hit.distance;
    if (match->partial) {
        int known = sb_v3_dot(hit.normal, hit.normal) > 0;
        charge->active = !hit.on_border && hit.distance < match->reach &&
                         (!known || sb_v3_dot(normal, hit.normal) > match->least_cosine);
    }
    if (!charge->active)
        return;
    if (match->method == REG_PBSM_LAPLACE)
        charge->active = regi_match_feel_grid(match, charge, normal);
    else
        regi_match_feel_distance(match, charge, &hit, normal);
}

static void regi_match_look_chunk(void *user, int chunk)
{
    reg_match *match = (reg_match *)user;
    int first = chunk * REGI_MATCH_CHUNK, last = sbi_min_int(first + REGI_MATCH_CHUNK, match->charge_count);
    for (int i = first; i < last; i++)
        regi_match_look_at(match, i);
}

/* Sums over the charges, in their order. Returns the electric energy (J). */
REGI_API double regi_match_look(reg_match *match)
{
    double area = 0, mean = 0, energy = 0;
    sb_real most = 0;
    int chunks = (match->charge_count + REGI_MATCH_CHUNK - 1) / REGI_MATCH_CHUNK;
    sbi_run(sbi_body_jobs(match->body), regi_match_look_chunk, match, chunks);
    for (int i = 0; i < match->charge_count; i++) {
        const regi_match_charge *charge = match->charges + i;
        if (!charge->active)
            continue;
        area += (double)charge->area;
        mean += (double)charge->area * (double)charge->distance;
        energy += (double)charge->area * (double)charge->energy;
        most = sb_max(most, charge->distance);
    }
    match->info.active = (sb_real)(area / match->total_area);
    match->info.mean_distance = area > 0 ? (sb_real)(mean / area) : 0;
    match->info.max_distance = most;
    return energy * (double)match->charge * (double)match->young;
}

/* ---- the system ---- */

/* Charges pull against the slope of the potential, landmarks are springs to where they are seen: sbi_potential_fill. */
REGI_API void regi_match_fill(void *user, const sb_vec3 *u, sb_vec3 *force, sb_real *stiffness, sb_vec3 *lines)
{
    reg_match *match = (reg_match *)user;
    double begin = regi_match_now(match);
    sb_real q = match->charge * match->young;
    match->shape = u;
    match->electric = regi_match_look(match);
    match->info.landmark_distance = 0;
    for (int i = 0; i < match->charge_count; i++) {
        const regi_match_charge *charge = match->charges + i;
        sb_real weight = charge->active ? q * charge->area : 0;
        force[i] = charge->active ? sb_v3_scale(-weight, charge->force) : sb_v3(0, 0, 0);
        stiffness[i] = charge->active ? weight * charge->stiffness : 0;
        lines[i] = charge->active ? charge->line : sb_v3(0, 0, 0);
    }
    for (int i = match->charge_count; i < match->charge_count + match->landmark_count; i++) {
        sb_vec3 gap = sb_v3_sub(match->targets[match->charges[i].index], regi_match_point(match, i));
        force[i] = sb_v3_scale(match->landmark_stiffness, gap);
        stiffness[i] = match->landmark_stiffness;
        lines[i] = sb_v3(0, 0, 0);
        match->info.landmark_distance = sb_max(match->info.landmark_distance, sb_v3_norm(gap));
    }
    match->shape = sb_body_displacements(match->body);
    match->info.seconds_field = regi_match_now(match) - begin;
}

/* ---- moving ---- */

/* Length of the longest increment; not finite when one is not. */
static sb_real regi_match_largest(const sb_vec3 *increment, int count)
{
    sb_real most = 0;
    for (int i = 0; i < count; i++) {
        sb_real length = sb_v3_norm(increment[i]);
        if (!sb_is_finite(length))
            return length;
        most = sb_max(most, length);
    }
    return most;
}

REGI_API sb_result regi_match_shorten(reg_match *match, const sb_vec3 *increment)
{
    const sb_vec3 *shape = sb_body_displacements(match->body);
    int n = match->mesh.node_count, bad = 0;
    sb_real largest = regi_match_largest(increment, n), limit = (sb_real)0.1 * match->size, share, energy;
    if (!sb_is_finite(largest))
        return sbi_fail(&match->info.error, SB_ERROR_DIVERGED, "the step of a match is not finite");
    share = largest > limit ? limit / largest : 1;
    for (int cut = 0; cut < 20; cut++, share *= (sb_real)0.5) {
        for (int i = 0; i < n; i++)
            match->trial[i] = sb_v3_madd(shape[i], share, increment[i]);
        bad = sbi_body_try_shape(match->body, match->trial, &energy);
        if (bad < 0 && sb_is_finite(energy)) {
            match->info.change = share * largest;
            return SB_OK;
        }
    }
    return sbi_fail_element(&match->info.error, SB_ERROR_INVERTED, bad,
                            "element %d would turn inside out however short the step", bad);
}

/* ---- control ---- */

/* 1 when neither charge nor reach changes any more. */
static int regi_match_is_full(const reg_match *match)
{
    return match->charge >= match->last_charge && (!match->partial || match->reach <= match->last_reach);
}

/* Along the surface only the body holds a charge, and where that rests on an edge between two facets of the target each
 * step turns it over to the other one: at full charge places would swing to and fro for ever. Aitken's relaxation takes
 * the share of the increment at which the last two cancel out; all of it where they grow, since then something moved.
 * Supports go where they are to be in any case. */
static void regi_match_relax(reg_match *match, sb_vec3 *increment)
{
    const sb_real least = (sb_real)0.1;
    const unsigned char *fixed = sb_body_supports(match->body);
    double fall = 0, square = 0;
    sb_real share = 1;
    for (int i = 0; i < match->mesh.node_count && match->relaxation > 0; i++) {
        sb_vec3 less = sb_v3_sub(match->last[i], increment[i]);
        fall += (double)sb_v3_dot(match->last[i], less);
        square += (double)sb_v3_dot(less, less);
    }
    if (fall > 0)
        share = sb_max(least, sb_min(match->relaxation * (sb_real)(fall / square), 1));
    for (int i = 0; i < match->mesh.node_count; i++) {
        match->last[i] = increment[i];
        increment[i] = sbi_body_pick_axes(fixed[i], increment[i], sb_v3_scale(share, increment[i]));
    }
    match->relaxation = share;
}

/* q <- q clamp(I_int / I_phi), and a partial target's reach shrinks. */
static void regi_match_raise(reg_match *match, double elastic, double electric)
{
    sb_real ratio = electric > 0 ? (sb_real)(elastic / electric) : match->most_growth;
    ratio = sb_max(match->least_growth, sb_min(ratio, match->most_growth));
    match->charge = sb_min(match->charge * ratio, match->last_charge);
    match->reach = sb_max(match->last_reach, (sb_real)0.93 * match->reach);
}

/* Three steps running at full charge and reach without a fall of the mean distance worth the name. */
static void regi_match_judge(reg_match *match)
{
    sb_real mean = match->info.mean_distance;
    match->calm = regi_match_is_full(match) && mean >= (1 - match->settled) * match->last_mean ? match->calm + 1 : 0;
    if (!(mean >= match->last_mean))
        match->last_mean = mean;
    match->info.stop = match->calm >= 3 ? REG_MATCH_SETTLED : REG_MATCH_RUNNING;
}

/* Of a point, a flat patch or a target in another unit the charges make what no organ looks like. */
static sb_result regi_match_check_shape(reg_match *match)
{
    sb_mesh mesh = match->mesh;
    double share;
    mesh.nodes = sbi_body_shape(match->body).nodes;
    share = (double)(sb_mesh_volume(&mesh) / match->volume);
    if (share > 0.25 && share < 4)
        return SB_OK;
    return sbi_fail(&match->info.error, SB_ERROR_DIVERGED,
                    "the organ's volume has become %.3g times what it was: the "
                    "target shows a part of it only, or is of another size",
                    share);
}

/* What the look that came with the system says against going on. */
static sb_result regi_match_check_look(reg_match *match)
{
    if (match->partial && match->info.active < match->least_active && match->landmark_count == 0)
        return sbi_fail(&match->info.error, SB_ERROR_NOT_CONVERGED,
                        "only %.1f %% of the organ's surface is near the "
                        "target and faces as it does: align them first",
                        100 * (double)match->info.active);
    return regi_match_is_full(match) ? regi_match_check_shape(match) : SB_OK;
}

/* Solves for the increment and finds the shape it leads to, in match->trial. */
static sb_result regi_match_solve(reg_match *match, sbi_step *step)
{
    double begin = regi_match_now(match);
    sb_result result = sbi_step_solve(step);
    match->info.pcg_iterations = step->info->pcg_iterations;
    match->info.seconds_solve = regi_match_now(match) - begin;
    if (result != SB_OK)
        return sbi_fail(&match->info.error, result, "the system of a match could not be solved");
    if (regi_match_is_full(match))
        regi_match_relax(match, sbi_relax_increment(step));
    return regi_match_shorten(match, sbi_relax_increment(step));
}

/* Rigid motions that nothing holds would leave the matrix singular: the stiffness that holds them is far below what a
 * charge adds. The next step sees what the loose tolerance leaves. */
static sb_result regi_match_try(reg_match *match)
{
    sb_body *body = match->body;
    sb_step_info info;
    sbi_step step;
    double begin = regi_match_now(match);
    sb_real elastic = 0, held = (sb_real)1e-4 * match->young * match->size;
    sb_result assembled = sbi_relax_begin(body, match->potential, held, (sb_real)1e-2, &info, &step), result;
    match->info.seconds_system = regi_match_now(match) - begin - match->info.seconds_field;
    result = info.error.result == SB_ERROR_MEMORY ? SB_OK : regi_match_check_look(match);
    if (result == SB_OK && assembled != SB_OK) {
        match->info.error = info.error;
        result = assembled;
    }
    if (result == SB_OK)
        (void)sbi_body_try_shape(body, sb_body_displacements(body), &elastic);
    if (result == SB_OK)
        result = regi_match_solve(match, &step);
    sbi_relax_end(&step, match->potential, result == SB_OK ? match->trial : NULL);
    if (result != SB_OK)
        return result;
    match->info.charge = match->charge;
    regi_match_judge(match);
    regi_match_raise(match, (double)elastic, match->electric);
    match->info.iterations++;
    return SB_OK;
}

REG_API sb_result reg_match_step(reg_match *match, reg_match_info *info)
{
    sb_result result;
    double begin;
    if (!match)
        return SB_ERROR_ARGUMENT;
    begin = regi_match_now(match);
    memset(&match->info.error, 0, sizeof match->info.error);
    match->info.error.element = match->info.error.node = -1;
    result = sbi_body_check_version(match->body, match->mesh_version, &match->info.error);
    if (result == SB_OK && sbi_body_has_constraints(match->body))
        result = sbi_fail(&match->info.error, SB_ERROR_UNSUPPORTED, "the body has constraints now");
    if (result == SB_OK)
        result = regi_match_try(match);
    match->info.seconds += regi_match_now(match) - begin;
    if (result != SB_OK)
        match->info.stop = result == SB_ERROR_NOT_CONVERGED ? REG_MATCH_NO_OVERLAP : REG_MATCH_FAILED;
    if (info)
        *info = match->info;
    return result;
}

REG_API sb_result reg_match_run(reg_match *match, int steps, reg_match_info *info)
{
    sb_result result = SB_OK;
    if (!match || steps < 1)
        return SB_ERROR_ARGUMENT;
    match->info.stop = REG_MATCH_RUNNING;
    for (int i = 0; result == SB_OK && match->info.stop == REG_MATCH_RUNNING; i++) {
        if (i == steps)
            match->info.stop = REG_MATCH_STEP_CAP;
        else if (match->info.seconds >= match->max_seconds)
            match->info.stop = REG_MATCH_TIME_CAP;
        else
            result = reg_match_step(match, NULL);
    }
    if (info)
        *info = match->info;
    return result;
}
