/* nicp_step: a look at the target, partners both ways, and the balance after it. */
#include <string.h>

#include "../softbody/body/load.h"
#include "../softbody/body/step.h"
#include "nicp_private.h"

static double regi_nicp_now(const reg_nicp *nicp) { return nicp->clock ? nicp->clock() : 0.0; }

REGI_API void regi_nicp_points(const reg_nicp *nicp, const regi_nicp_rows *rows, sb_vec3 *points)
{
    sb_mapping_apply(&rows->mapping, sb_body_positions(nicp->body), points);
}

/* ---- what the camera sees ---- */

static sb_vec3 regi_nicp_normal(const reg_nicp *nicp, const regi_nicp_source *source)
{
    sb_surface_hit corner;
    memset(&corner, 0, sizeof corner);
    if (source->triangle < 0)
        return sb_v3(0, 0, 0);
    corner.triangle = source->triangle;
    corner.feature = SB_SURFACE_VERTEX;
    corner.index = source->corner;
    return sb_surface_normal(nicp->skin, &corner);
}

static int regi_nicp_sees(const reg_nicp *nicp, const regi_nicp_source *source)
{
    sb_vec3 at = nicp->vertices[source->vertex], way = sb_v3_sub(nicp->camera, at);
    sb_real length = sb_v3_norm(way), clear = (sb_real)1e-3 * nicp->size;
    if (nicp->view == REG_NICP_ALL)
        return 1;
    if (!(sb_v3_dot(source->normal, way) > 0))
        return 0;
    if (nicp->view == REG_NICP_FACING || !(length > clear))
        return 1;
    at = sb_v3_madd(at, clear, source->normal); /* off its own facets */
    way = sb_v3_sub(nicp->camera, at);
    return !sb_surface_ray(nicp->skin, at, way, sb_v3_norm(way), NULL);
}

/* ---- partners ---- */

/* 1 unless both normals are known and look different ways. */
static int regi_nicp_agrees(const reg_nicp *nicp, sb_vec3 a, sb_vec3 b)
{
    return sb_v3_dot(a, a) == 0 || sb_v3_dot(b, b) == 0 || sb_v3_dot(a, b) > nicp->least_cosine;
}

/* Beyond the rim of what was seen, where the closest place is the rim itself. A surface knows its rim. Of a cloud's
 * point the way back tells: on the rim it does not lead to the source but to what is above the rim. */
static int regi_nicp_is_beyond(const reg_nicp *nicp, regi_nicp_source *source, sb_vec3 at, const reg_field_hit *hit)
{
    sb_surface_hit back;
    sb_real aside;
    if (!nicp->is_cloud)
        return hit->on_border;
    if (!sb_surface_closest_from(nicp->skin, hit->point, SB_REAL_MAX, source->way_back, &back))
        return 1;
    source->way_back = back.triangle;
    aside = sb_v3_norm(sb_v3_sub(back.point, at));
    return aside > (sb_real)0.7 * hit->distance && aside > 2 * nicp->spacing;
}

static void regi_nicp_look_at(reg_nicp *nicp, regi_nicp_source *source)
{
    sb_vec3 at = nicp->vertices[source->vertex];
    reg_field_hit hit;
    source->normal = regi_nicp_normal(nicp, source);
    source->direction = source->normal;
    source->visible = regi_nicp_sees(nicp, source);
    source->paired = source->visible && reg_field_closest(nicp->field, at, source->guess, &hit);
    if (!source->paired)
        return;
    source->guess = hit.item;
    source->distance = hit.distance;
    source->way = sb_v3_sub(hit.point, at);
    source->paired = regi_nicp_agrees(nicp, source->normal, hit.normal) && !regi_nicp_is_beyond(nicp, source, at, &hit);
    if (sb_v3_dot(hit.normal, hit.normal) > 0 && !nicp->noisy)
        source->direction = hit.normal;
}

static void regi_nicp_look_chunk(void *user, int chunk)
{
    reg_nicp *nicp = (reg_nicp *)user;
    int first = chunk * REGI_NICP_CHUNK, last = sbi_min_int(first + REGI_NICP_CHUNK, nicp->source_count);
    for (int i = first; i < last; i++)
        regi_nicp_look_at(nicp, nicp->sources + i);
}

/* The source that stands for the corner that the closest place of the skin is nearest to. */
static void regi_nicp_look_back(reg_nicp *nicp, regi_nicp_sample *sample)
{
    sb_surface_hit hit;
    int nodes[3], nearest = 0;
    sample->source = -1;
    if (!sb_surface_closest_from(nicp->skin, sample->point, SB_REAL_MAX, sample->guess, &hit))
        return;
    sample->guess = hit.triangle;
    if (!regi_nicp_agrees(nicp, sb_surface_normal(nicp->skin, &hit), sample->normal))
        return;
    (void)sb_surface_triangle(nicp->skin, hit.triangle, nodes);
    for (int k = 1; k < 3; k++)
        if (hit.weights[k] > hit.weights[nearest])
            nearest = k;
    sample->source = nicp->source_of[nodes[nearest]];
    sample->way = sb_v3_sub(sample->point, hit.point);
}

static void regi_nicp_look_back_chunk(void *user, int chunk)
{
    reg_nicp *nicp = (reg_nicp *)user;
    int first = chunk * REGI_NICP_CHUNK, last = sbi_min_int(first + REGI_NICP_CHUNK, nicp->sample_count);
    for (int i = first; i < last; i++)
        regi_nicp_look_back(nicp, nicp->samples + i);
}

/* Share of the way of what changes geometrically over the increments: from^(1 - share) to^share. */
static sb_real regi_nicp_between(sb_real from, sb_real to, sb_real share)
{
    return from * sb_exp(share * sb_log(to / from));
}

static sb_real regi_nicp_reach(const reg_nicp *nicp)
{
    sb_real last = (sb_real)sbi_max_int(nicp->increments - 1, 1);
    return regi_nicp_between(nicp->reach, nicp->last_reach, (sb_real)nicp->increment / last);
}

/* Largest distance[count] that counts. */
static sb_real regi_nicp_limit(const reg_nicp *nicp, int count)
{
    sb_real limit = reg_outlier_limit(nicp->distances, count, nicp->outliers, nicp->outlier_parameter, nicp->scratch);
    return sb_max(limit, regi_nicp_reach(nicp));
}

static void regi_nicp_prune_sources(reg_nicp *nicp)
{
    sb_real limit;
    int count = 0;
    for (int i = 0; i < nicp->source_count; i++)
        if (nicp->sources[i].paired)
            nicp->distances[count++] = nicp->sources[i].distance;
    limit = regi_nicp_limit(nicp, count);
    for (int i = 0; i < nicp->source_count; i++)
        nicp->sources[i].paired = nicp->sources[i].paired && nicp->sources[i].distance <= limit;
}

/* V(i), without the pairs that are too far apart. */
static void regi_nicp_gather_samples(reg_nicp *nicp)
{
    sb_real limit;
    int count = 0;
    for (int i = 0; i < nicp->source_count; i++) {
        nicp->sources[i].sum = sb_v3(0, 0, 0);
        nicp->sources[i].count = 0;
    }
    for (int j = 0; j < nicp->sample_count; j++)
        if (nicp->samples[j].source >= 0)
            nicp->distances[count++] = sb_v3_norm(nicp->samples[j].way);
    limit = regi_nicp_limit(nicp, count);
    for (int j = 0; j < nicp->sample_count; j++) {
        const regi_nicp_sample *sample = nicp->samples + j;
        if (sample->source >= 0 && sb_v3_norm(sample->way) <= limit) {
            regi_nicp_source *source = nicp->sources + sample->source;
            source->sum = sb_v3_add(source->sum, sample->way);
            source->count++;
        }
    }
}

/* (5.4) */
static sb_vec3 regi_nicp_blend(const reg_nicp *nicp, const regi_nicp_source *source)
{
    if (source->count == 0)
        return source->way;
    return sb_v3_madd(sb_v3_scale(nicp->blending, source->way), (1 - nicp->blending) / (sb_real)source->count,
                      source->sum);
}

/* Stiffness and goal of each source; what is told of them. */
static void regi_nicp_set_goals(reg_nicp *nicp, sb_real stiffness)
{
    double area = 0, mean = 0;
    sb_real slide = sb_sqrt(nicp->sliding);
    reg_nicp_info *info = &nicp->info;
    info->visible = info->pruned = 0;
    info->max_distance = 0;
    for (int i = 0; i < nicp->source_count; i++) {
        regi_nicp_source *source = nicp->sources + i;
        nicp->goals[i] = nicp->before[i] = nicp->vertices[source->vertex];
        source->active = source->paired;
        nicp->lines[i] = sb_v3_scale(slide, source->direction);
        nicp->stiffness[i] = source->active ? stiffness * source->area : 0;
        info->visible += source->visible;
        info->pruned += source->visible && !source->active;
        if (!source->active)
            continue;
        nicp->goals[i] = sb_v3_add(nicp->goals[i], regi_nicp_blend(nicp, source));
        area += (double)source->area;
        mean += (double)source->area * (double)source->distance;
        info->max_distance = sb_max(info->max_distance, source->distance);
    }
    info->active = (sb_real)(area / nicp->total_area);
    info->mean_distance = area > 0 ? (sb_real)(mean / area) : 0;
}

static sb_result regi_nicp_pair(reg_nicp *nicp, sb_real stiffness)
{
    const sb_jobs *jobs = sbi_body_jobs(nicp->body);
    sb_result result;
    regi_nicp_points(nicp, &nicp->rows, nicp->vertices);
    result = sb_surface_move(nicp->skin, nicp->vertices, jobs, &nicp->info.error);
    if (result != SB_OK)
        return result;
    sbi_run(jobs, regi_nicp_look_chunk, nicp, (nicp->source_count + REGI_NICP_CHUNK - 1) / REGI_NICP_CHUNK);
    if (nicp->blending < 1)
        sbi_run(jobs, regi_nicp_look_back_chunk, nicp, (nicp->sample_count + REGI_NICP_CHUNK - 1) / REGI_NICP_CHUNK);
    regi_nicp_prune_sources(nicp);
    regi_nicp_gather_samples(nicp);
    regi_nicp_set_goals(nicp, stiffness);
    if (nicp->info.active < nicp->least_active && nicp->landmark_count == 0)
        return sbi_fail(&nicp->info.error, SB_ERROR_NOT_CONVERGED,
                        "only %.1f %% of the organ's surface has a partner "
                        "on the target: align them first",
                        100 * (double)nicp->info.active);
    return SB_OK;
}

/* ---- balance ---- */

/* The balance with rows that are soft along the surface. Penalties act within it only: who steps the body between two
 * looks has it to himself. */
static sb_result regi_nicp_solve(reg_nicp *nicp, const sb_static_options *options, sb_step_info *step)
{
    const sb_real none = 0;
    sb_body *body = nicp->body;
    sb_result result = sb_body_solve_static(body, options, step);
    (void)sbi_body_set_mapping_lines(body, nicp->surface_load, NULL);
    (void)sb_body_set_mapping_stiffness(body, nicp->surface_load, &none, 1);
    if (nicp->landmark_load)
        (void)sb_body_set_mapping_stiffness(body, nicp->landmark_load, &none, 1);
    return result;
}

static sb_result regi_nicp_balance(reg_nicp *nicp)
{
    sb_static_options options = sb_default_static_options();
    sb_step_info step;
    sb_result result = sb_body_set_mapping_targets(nicp->body, nicp->surface_load, nicp->goals);
    if (result == SB_OK)
        result = sb_body_set_mapping_stiffness(nicp->body, nicp->surface_load, nicp->stiffness, 0);
    if (result == SB_OK && nicp->landmark_load)
        result = sb_body_set_mapping_stiffness(nicp->body, nicp->landmark_load, &nicp->landmark_stiffness, 1);
    if (result == SB_OK)
        result = sbi_body_set_mapping_lines(nicp->body, nicp->surface_load, nicp->lines);
    if (result == SB_ERROR_MEMORY)
        return sbi_fail(&nicp->info.error, result, "no memory for the lines of %d sources", nicp->source_count);
    if (result != SB_OK)
        return sbi_fail(&nicp->info.error, result, "the penalties of the registration are gone from the body");
    options.tolerance = nicp->newton_tolerance;
    options.max_newton = nicp->newton;
    options.quasi_newton = options.forces_only = 1; /* the next look changes the forces more than that leaves */
    options.max_iterations = sbi_body_max_iterations(nicp->body);
    options.keep_progress = 1; /* the next look starts from there */
    result = regi_nicp_solve(nicp, &options, &step);
    nicp->info.newton_iterations = step.newton_iterations;
    nicp->info.pcg_iterations = step.pcg_iterations;
    if (result != SB_OK && step.load_steps == 0) {
        nicp->info.error = step.error;
        return result;
    }
    return SB_OK;
}

/* rms distance of the sources from where they were (m). */
static sb_real regi_nicp_motion(const reg_nicp *nicp, const sb_vec3 *from)
{
    double sum = 0;
    for (int i = 0; i < nicp->source_count; i++) {
        sb_vec3 d = sb_v3_sub(nicp->vertices[nicp->sources[i].vertex], from[i]);
        sum += (double)nicp->sources[i].area * (double)sb_v3_dot(d, d);
    }
    return (sb_real)sqrt(sum / nicp->total_area);
}

/* ---- control ---- */

/* k0 (k1 / k0)^(i / n), i from 1. */
static sb_real regi_nicp_stiffness(const reg_nicp *nicp)
{
    return regi_nicp_between(nicp->first_stiffness, nicp->last_stiffness,
                             (sb_real)(nicp->increment + 1) / (sb_real)nicp->increments);
}

/* An increment ends when a look changes nothing more, or when it has had its looks; the run when two increments end
 * alike. */
static void regi_nicp_judge(reg_nicp *nicp)
{
    sb_real least = nicp->tolerance * nicp->size;
    if (++nicp->iteration < nicp->iterations && nicp->info.change > least)
        return;
    if (nicp->increment + 1 == nicp->increments)
        nicp->info.stop = REG_NICP_INCREMENTS;
    else if (nicp->has_settled && regi_nicp_motion(nicp, nicp->settled) <= least)
        nicp->info.stop = REG_NICP_CONVERGED;
    for (int i = 0; i < nicp->source_count; i++)
        nicp->settled[i] = nicp->vertices[nicp->sources[i].vertex];
    nicp->has_settled = 1;
    nicp->iteration = 0;
    nicp->increment = sbi_min_int(nicp->increment + 1, nicp->increments - 1);
}

static void regi_nicp_read_landmarks(reg_nicp *nicp)
{
    const sb_mapping *rows = &nicp->landmark_rows.mapping;
    sb_real most = 0;
    for (int i = 0; i < nicp->landmark_count; i++) {
        sb_vec3 at = sb_v3(0, 0, 0);
        for (int k = rows->row_start[i]; k < rows->row_start[i + 1]; k++)
            at = sb_v3_madd(at, rows->weights[k], sb_body_positions(nicp->body)[rows->nodes[k]]);
        most = sb_max(most, sb_v3_norm(sb_v3_sub(nicp->targets[i], at)));
    }
    nicp->info.landmark_distance = most;
}

/* Of a point, a flat patch or a target in another unit the penalties make what no organ looks like. */
static sb_result regi_nicp_check_shape(reg_nicp *nicp)
{
    sb_mesh mesh = nicp->mesh;
    double share;
    mesh.nodes = sbi_body_shape(nicp->body).nodes;
    share = (double)(sb_mesh_volume(&mesh) / nicp->volume);
    if (share > 0.25 && share < 4)
        return SB_OK;
    return sbi_fail(&nicp->info.error, SB_ERROR_DIVERGED,
                    "the organ's volume has become %.3g times what it was: the "
                    "target shows a part of it only, or is of another size",
                    share);
}

static sb_result regi_nicp_try(reg_nicp *nicp)
{
    double begin = regi_nicp_now(nicp), paired;
    sb_real stiffness = regi_nicp_stiffness(nicp);
    sb_result result;
    regi_nicp_read_landmarks(nicp);
    result = nicp->info.iterations > 0 ? regi_nicp_check_shape(nicp) : SB_OK;
    if (result == SB_OK)
        result = regi_nicp_pair(nicp, stiffness);
    paired = regi_nicp_now(nicp);
    nicp->info.seconds_pairs = paired - begin;
    if (result == SB_OK)
        result = regi_nicp_balance(nicp);
    nicp->info.seconds_solve = regi_nicp_now(nicp) - paired;
    if (result != SB_OK)
        return result;
    regi_nicp_points(nicp, &nicp->rows, nicp->vertices);
    nicp->info.change = regi_nicp_motion(nicp, nicp->before);
    nicp->info.stiffness = stiffness;
    nicp->info.increment = nicp->increment + 1;
    nicp->info.stop = REG_NICP_RUNNING;
    nicp->info.iterations++;
    regi_nicp_judge(nicp);
    return SB_OK;
}

REG_API sb_result reg_nicp_step(reg_nicp *nicp, reg_nicp_info *info)
{
    sb_result result;
    double begin;
    if (!nicp)
        return SB_ERROR_ARGUMENT;
    begin = regi_nicp_now(nicp);
    memset(&nicp->info.error, 0, sizeof nicp->info.error);
    nicp->info.error.element = nicp->info.error.node = -1;
    result = sbi_body_check_version(nicp->body, nicp->mesh_version, &nicp->info.error);
    if (result == SB_OK)
        result = regi_nicp_try(nicp);
    nicp->info.seconds += regi_nicp_now(nicp) - begin;
    if (result == SB_ERROR_STATE)
        nicp->info.stop = REG_NICP_FAILED;
    else if (result != SB_OK)
        nicp->info.stop =
            nicp->info.active < nicp->least_active && nicp->landmark_count == 0 ? REG_NICP_NO_OVERLAP : REG_NICP_FAILED;
    if (info)
        *info = nicp->info;
    return result;
}

REG_API sb_result reg_nicp_run(reg_nicp *nicp, int steps, reg_nicp_info *info)
{
    sb_result result = SB_OK;
    if (!nicp || steps < 1)
        return SB_ERROR_ARGUMENT;
    nicp->info.stop = REG_NICP_RUNNING;
    for (int i = 0; result == SB_OK && nicp->info.stop == REG_NICP_RUNNING; i++) {
        if (i == steps)
            nicp->info.stop = REG_NICP_STEP_CAP;
        else if (nicp->info.seconds >= nicp->max_seconds)
            nicp->info.stop = REG_NICP_TIME_CAP;
        else
            result = reg_nicp_step(nicp, NULL);
    }
    if (info)
        *info = nicp->info;
    return result;
}
