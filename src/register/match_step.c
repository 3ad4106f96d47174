/* match_step: one step of a match: look at the target, pull, solve, raise the charge. */
#include <string.h>

#include "../softbody/body/load.h"
#include "match_private.h"

static double regi_match_now(const reg_match *match) { return match->clock ? match->clock() : 0.0; }

static const int *regi_match_nodes(const reg_match *match, int charge)
{
    return match->body->domain.cells + (size_t)match->charges[charge].element * (size_t)match->width;
}

REGI_API sb_vec3 regi_match_point(const reg_match *match, int charge)
{
    const int *nodes = regi_match_nodes(match, charge);
    const sb_real *weights = match->weights + (size_t)charge * (size_t)match->width;
    sb_vec3 x = sb_v3(0, 0, 0);
    for (int a = 0; a < match->width; a++)
        x = sb_v3_madd(x, weights[a], match->body->position[nodes[a]]);
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
        f = sb_m3_add(f, sb_m3_outer(match->body->position[nodes[a]], gradients[a]));
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
    sbi_run(&match->body->jobs, regi_match_look_chunk, match, chunks);
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

/* Adds `scale` line line^T of one charge to the element's stiffness, of which the blocks from the diagonal to the right
 * are kept. */
static void regi_match_add_line(sb_real *local, int width, const sb_real *weights, sb_vec3 line, sb_real scale)
{
    sb_real v[3 * SB_MAX_ELEMENT_NODES];
    int size = 3 * width;
    for (int a = 0; a < width; a++) {
        v[3 * a] = weights[a] * line.x;
        v[3 * a + 1] = weights[a] * line.y;
        v[3 * a + 2] = weights[a] * line.z;
    }
    for (int i = 0; i < size; i++) {
        sb_real s = scale * v[i], *SB_RESTRICT row = local + i * size;
        for (int j = i - i % 3; j < size; j++)
            row[j] += s * v[j];
    }
}

static void regi_match_pull_nodes(reg_match *match, int index, sb_vec3 force)
{
    const int *nodes = regi_match_nodes(match, index);
    const sb_real *weights = match->weights + (size_t)index * (size_t)match->width;
    for (int a = 0; a < match->width; a++)
        match->pull[nodes[a]] = sb_v3_madd(match->pull[nodes[a]], weights[a], force);
}

/* The element's stiffness to its blocks of the matrix. */
static void regi_match_scatter(reg_match *match, int index)
{
    sb_matrix *matrix = &match->body->matrix;
    const int *nodes = regi_match_nodes(match, index);
    size_t size = 3 * (size_t)match->width;
    for (int a = 0; a < match->width; a++)
        for (int b = a; b < match->width; b++) {
            int at = sb_matrix_find(matrix, nodes[a], nodes[b]);
            sb_real *block = matrix->blocks[at], *mirror = matrix->blocks[matrix->transpose[at]];
            const sb_real *from = match->local + 3 * (size_t)a * size + 3 * (size_t)b;
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++) {
                    block[3 * i + j] += from[(size_t)i * size + (size_t)j];
                    if (b != a)
                        mirror[3 * j + i] += from[(size_t)i * size + (size_t)j];
                }
        }
}

/* Charges pull against the slope of the potential. */
static void regi_match_add_charges(reg_match *match)
{
    size_t bytes = 9 * (size_t)match->width * (size_t)match->width * sizeof(sb_real);
    sb_real q = match->charge * match->young;
    for (int i = 0; i < match->charge_count;) {
        int first = i, any = 0;
        memset(match->local, 0, bytes);
        for (; i < match->charge_count && match->charges[i].element == match->charges[first].element; i++) {
            const regi_match_charge *charge = match->charges + i;
            if (!charge->active)
                continue;
            any = 1;
            regi_match_pull_nodes(match, i, sb_v3_scale(-q * charge->area, charge->force));
            regi_match_add_line(match->local, match->width, match->weights + (size_t)i * (size_t)match->width,
                                charge->line, q * charge->area * charge->stiffness);
        }
        if (any)
            regi_match_scatter(match, first);
    }
}

/* Landmarks are springs to where they are seen. */
static void regi_match_add_landmarks(reg_match *match)
{
    size_t bytes = 9 * (size_t)match->width * (size_t)match->width * sizeof(sb_real);
    match->info.landmark_distance = 0;
    for (int i = match->charge_count; i < match->charge_count + match->landmark_count; i++) {
        sb_vec3 gap = sb_v3_sub(match->targets[match->charges[i].index], regi_match_point(match, i));
        memset(match->local, 0, bytes);
        for (int axis = 0; axis < 3; axis++)
            regi_match_add_line(match->local, match->width, match->weights + (size_t)i * (size_t)match->width,
                                sb_v3(axis == 0, axis == 1, axis == 2), match->landmark_stiffness);
        regi_match_pull_nodes(match, i, sb_v3_scale(match->landmark_stiffness, gap));
        regi_match_scatter(match, i);
        match->info.landmark_distance = sb_max(match->info.landmark_distance, sb_v3_norm(gap));
    }
}

/* Rigid motions that nothing holds would leave the matrix singular: this much stiffness is far below what a charge
 * adds. Source of the mass: any positive diagonal would do. */
static sb_real regi_match_mass_factor(const reg_match *match)
{
    sb_real mass = sb_body_mass(match->body);
    return mass > 0 ? (sb_real)1e-4 * match->young * match->size / mass : 0;
}

/* matrix and rhs of the step; supports go where they are to be. */
static sb_result regi_match_assemble(reg_match *match, sb_real *elastic)
{
    sb_body *b = match->body;
    int n = b->domain.node_count, bad = sbi_assembly_force(&b->assembly, b->displacement, b->internal);
    b->force_current = bad < 0;
    if (bad < 0)
        bad = sbi_assembly_energy(&b->assembly, b->displacement, elastic);
    if (bad >= 0)
        return sbi_fail_element(&match->info.error, SB_ERROR_INVERTED, bad,
                                "element %d is inside out, which its material does not allow", bad);
    sbi_assembly_tangent(&b->assembly, b->displacement, SB_TANGENT_QUASI, 1, &b->matrix);
    sbi_body_add_mass(b, regi_match_mass_factor(match));
    memset(match->pull, 0, (size_t)n * sizeof(sb_vec3));
    regi_match_add_charges(match);
    regi_match_add_landmarks(match);
    if (b->load_count) {
        sbi_loads_add_tangent(b, b->displacement, SB_TANGENT_QUASI, 1, &b->matrix);
        (void)sbi_loads_force(b, b->displacement, 1);
    }
    for (int i = 0; i < n; i++) {
        sb_vec3 force = sb_v3_add(sb_v3_sub(match->pull[i], b->internal[i]), b->dead_load[i]);
        force = sb_v3_madd(force, b->load_mass[i], b->gravity);
        b->rhs[i] = b->load_count ? sb_v3_add(force, b->follower[i]) : force;
        b->increment[i] = sbi_body_pick_axes(b->fixed[i], sb_v3_sub(b->target[i], b->displacement[i]), sb_v3(0, 0, 0));
    }
    return SB_OK;
}

static sb_result regi_match_solve(reg_match *match)
{
    sb_body *b = match->body;
    sb_pcg_options options = sb_default_pcg_options();
    sb_pcg_info pcg;
    sb_result result;
    memset(&pcg, 0, sizeof pcg);
    sbi_matrix_constrain(&b->matrix, b->fixed, &b->increment[0].x, &b->rhs[0].x, &b->jobs);
    result = sbi_body_update_precond(b, b->precond, &b->matrix, &match->info.error);
    if (result != SB_OK)
        return result;
    options.tolerance = 1e-2; /* the next step sees what is left */
    options.max_iterations = b->max_iterations;
    options.jobs = &b->jobs;
    result = sb_pcg_solve(&b->matrix, b->precond, &b->rhs[0].x, &b->increment[0].x, &options, &b->pcg, &pcg);
    match->info.pcg_iterations = pcg.iterations;
    if (result == SB_ERROR_NOT_CONVERGED)
        return SB_OK;
    return result == SB_OK ? SB_OK
                           : sbi_fail(&match->info.error, result, "the system of a match could not be solved");
}

/* ---- moving ---- */

/* Largest component of the increment; not finite when one is not. */
static sb_real regi_match_largest(const sb_body *b)
{
    sb_real most = 0;
    for (int i = 0; i < b->domain.node_count; i++) {
        sb_real length = sb_v3_norm(b->increment[i]);
        if (!sb_is_finite(length))
            return length;
        most = sb_max(most, length);
    }
    return most;
}

/* Takes the increment, shortened so that no node moves more than a tenth of the organ's size, and until the material
 * admits the shape. */
REGI_API sb_result regi_match_move(reg_match *match)
{
    sb_body *b = match->body;
    sb_real largest = regi_match_largest(b), limit = (sb_real)0.1 * match->size, share, energy;
    int bad = 0;
    if (!sb_is_finite(largest))
        return sbi_fail(&match->info.error, SB_ERROR_DIVERGED, "the step of a match is not finite");
    share = largest > limit ? limit / largest : 1;
    for (int cut = 0; cut < 20; cut++, share *= (sb_real)0.5) {
        for (int i = 0; i < b->domain.node_count; i++)
            match->trial[i] = sb_v3_madd(b->displacement[i], share, b->increment[i]);
        bad = sbi_assembly_energy(&b->assembly, match->trial, &energy);
        if (bad < 0 && sb_is_finite(energy)) {
            match->info.change = share * largest;
            return sb_body_set_displacements(b, match->trial);
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
static void regi_match_relax(reg_match *match)
{
    const sb_real least = (sb_real)0.1;
    sb_body *b = match->body;
    double fall = 0, square = 0;
    sb_real share = 1;
    for (int i = 0; i < b->domain.node_count && match->relaxation > 0; i++) {
        sb_vec3 less = sb_v3_sub(match->last[i], b->increment[i]);
        fall += (double)sb_v3_dot(match->last[i], less);
        square += (double)sb_v3_dot(less, less);
    }
    if (fall > 0)
        share = sb_max(least, sb_min(match->relaxation * (sb_real)(fall / square), 1));
    for (int i = 0; i < b->domain.node_count; i++) {
        match->last[i] = b->increment[i];
        b->increment[i] = sbi_body_pick_axes(b->fixed[i], b->increment[i], sb_v3_scale(share, b->increment[i]));
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
    sb_mesh mesh = regi_match_mesh(match->body);
    double share;
    mesh.nodes = match->body->position;
    share = (double)(sb_mesh_volume(&mesh) / match->volume);
    if (share > 0.25 && share < 4)
        return SB_OK;
    return sbi_fail(&match->info.error, SB_ERROR_DIVERGED, "the organ's volume has become %.3g times what it was: the "
                    "target shows a part of it only, or is of another size", share);
}

static sb_result regi_match_try(reg_match *match)
{
    double begin = regi_match_now(match), looked, assembled, electric = regi_match_look(match);
    sb_real elastic = 0;
    sb_result result;
    looked = regi_match_now(match);
    match->info.seconds_field = looked - begin;
    if (match->partial && match->info.active < match->least_active && match->landmark_count == 0)
        return sbi_fail(&match->info.error, SB_ERROR_NOT_CONVERGED, "only %.1f %% of the organ's surface is near the "
                        "target and faces as it does: align them first", 100 * (double)match->info.active);
    result = regi_match_is_full(match) ? regi_match_check_shape(match) : SB_OK;
    if (result == SB_OK)
        result = regi_match_assemble(match, &elastic);
    assembled = regi_match_now(match);
    match->info.seconds_system = assembled - looked;
    if (result == SB_OK)
        result = regi_match_solve(match);
    match->info.seconds_solve = regi_match_now(match) - assembled;
    if (result == SB_OK && regi_match_is_full(match))
        regi_match_relax(match);
    if (result == SB_OK)
        result = regi_match_move(match);
    if (result != SB_OK)
        return result;
    match->info.charge = match->charge;
    regi_match_judge(match);
    regi_match_raise(match, (double)elastic, electric);
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
    if (match->body->elimination)
        result = sbi_fail(&match->info.error, SB_ERROR_UNSUPPORTED, "the body has constraints now");
    else
        result = sbi_body_check_unrecorded(match->body, &match->info.error);
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
