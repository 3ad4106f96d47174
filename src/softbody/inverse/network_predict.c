/* network_predict: see network_predict.h. */
#include "network_predict.h"

#include <math.h>
#include <string.h>

#include "../body/body_private.h"
#include "../body/step_guess.h"
#include "../body/step_private.h"
#include "network_private.h"

#define SBI_NETWORK_INPUT_COOKIE 0x9de5u

SB_API sb_network_input sb_default_network_input(void)
{
    sb_network_input input;
    memset(&input, 0, sizeof input);
    input.policy = SB_NETWORK_TAKE;
    input.limit = (sb_real)0.05;
    input.cookie = SBI_NETWORK_INPUT_COOKIE;
    return input;
}

/* ---- checks ---- */

static sb_result sbi_predict_check_grid(const sb_network *network, const sb_grid *grid, const sb_body *body,
                                        sb_error *error)
{
    const sb_real near = (sb_real)1e-3;
    const sb_network_shape *shape = &network->shape;
    const sb_real spacing[3] = {shape->spacing.x, shape->spacing.y, shape->spacing.z};
    const sb_real cell[3] = {grid->cell_size.x, grid->cell_size.y, grid->cell_size.z};
    if (grid->mesh.node_count < 1 || grid->mesh.node_count != body->domain.node_count)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the grid has %d nodes, the body %d: it was not made from this grid",
                        grid->mesh.node_count, body->domain.node_count);
    for (int axis = 0; axis < 3; axis++) {
        if (grid->counts[axis] >= shape->counts[axis])
            return sbi_fail(error, SB_ERROR_ARGUMENT, "the grid has %d nodes along axis %d, the network's lattice %d",
                            grid->counts[axis] + 1, axis, shape->counts[axis]);
        if (!(sb_abs(cell[axis] - spacing[axis]) <= near * spacing[axis]))
            return sbi_fail(error, SB_ERROR_ARGUMENT, "cells of the grid are %g m long along axis %d, the network's %g",
                            (double)cell[axis], axis, (double)spacing[axis]);
    }
    return SB_OK;
}

static sb_result sbi_predict_check_body(const sb_network *network, const sb_body *body, sb_error *error)
{
    const sb_real near = (sb_real)0.005;
    if (network->shape.inputs != SB_NETWORK_CHANNELS || network->shape.outputs != 3)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "the network has %d channels in and %d out, not %d and 3",
                        network->shape.inputs, network->shape.outputs, (int)SB_NETWORK_CHANNELS);
    if (body->live || body->touch)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "a network knows neither tools nor bodies with slack");
    for (int i = 0; i < body->material_count; i++) {
        sb_real poisson = sb_material_poisson(&body->materials[i]);
        if (!(sb_abs(poisson - network->shape.poisson) <= near))
            return sbi_fail(error, SB_ERROR_MATERIAL, "the network was trained for Poisson's ratio %g, not for %g",
                            (double)network->shape.poisson, (double)poisson);
    }
    return SB_OK;
}

static sb_result sbi_predict_check_input(const sb_network_input *input, int nodes, sb_error *error)
{
    if (input->cookie != SBI_NETWORK_INPUT_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the input was not made by sb_default_network_input");
    if (!input->displacements || input->count < 1 || (!input->nodes && input->count > nodes))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "input.displacements is NULL, or input.count not from 1 to %d",
                        nodes);
    if ((int)input->policy < SB_NETWORK_TAKE || (int)input->policy > SB_NETWORK_KEEP || !(input->limit >= 0) ||
        !sb_is_finite(input->limit))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "input.policy is unknown, or input.limit not at least 0 and finite");
    for (int k = 0; k < input->count; k++) {
        int node = input->nodes ? input->nodes[k] : k;
        if (node < 0 || node >= nodes)
            return sbi_fail_node(error, SB_ERROR_INDEX, node, "input.nodes[%d] is %d, the grid has %d nodes", k, node,
                                 nodes);
        if (!sb_v3_is_finite(input->displacements[k]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, node, "the displacement of node %d is not finite", node);
    }
    return SB_OK;
}

static sb_result sbi_predict_check(const sb_network *network, const sb_grid *grid, const sb_body *body,
                                   const sb_network_input *input, sb_error *error)
{
    sb_result result;
    if (!network || !grid || !body || !input)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a guess needs a network, a grid, a body and an input");
    result = sbi_predict_check_body(network, body, error);
    if (result == SB_OK)
        result = sbi_predict_check_grid(network, grid, body, error);
    return result == SB_OK ? sbi_predict_check_input(input, grid->mesh.node_count, error) : result;
}

/* ---- between grid and lattice ---- */

/* Node i's number in the lattice. */
static size_t sbi_predict_place(const sb_network *network, const sb_grid *grid, int i)
{
    const int *counts = network->shape.counts;
    sb_vec3 x = sb_v3_sub(grid->mesh.nodes[i], grid->origin);
    const sb_real at[3] = {x.x / grid->cell_size.x, x.y / grid->cell_size.y, x.z / grid->cell_size.z};
    size_t place[3];
    for (int axis = 0; axis < 3; axis++)
        place[axis] = (size_t)sb_min(sb_max(at[axis] + (sb_real)0.5, 0), (sb_real)grid->counts[axis]);
    return (place[2] * (size_t)counts[1] + place[1]) * (size_t)counts[0] + place[0];
}

/* Place along the longest side of the lattice, 0 to 1. */
static float sbi_predict_along(const sb_network *network, size_t place)
{
    const int *counts = network->shape.counts;
    size_t x = (size_t)counts[0], y = (size_t)counts[1];
    const size_t at[3] = {place % x, place / x % y, place / (x * y)};
    int longest = 0;
    for (int axis = 1; axis < 3; axis++)
        if (counts[axis] > counts[longest])
            longest = axis;
    return counts[longest] > 1 ? (float)at[longest] / (float)(counts[longest] - 1) : 0;
}

static sb_real sbi_predict_size(const sb_network_input *input)
{
    sb_real size = 0;
    for (int k = 0; k < input->count; k++)
        size = sb_max(size, sb_v3_norm(input->displacements[k]));
    return size;
}

/* The channels of network_predict.h. */
static void sbi_predict_fill(sb_network *network, const sb_grid *grid, const sb_network_input *input, sb_real size)
{
    const int *counts = network->shape.counts;
    size_t nodes = (size_t)counts[0] * (size_t)counts[1] * (size_t)counts[2];
    memset(network->channels, 0, nodes * SB_NETWORK_CHANNELS * sizeof(float));
    for (int i = 0; i < grid->mesh.node_count; i++) {
        size_t place = sbi_predict_place(network, grid, i);
        float *channel = network->channels + place * SB_NETWORK_CHANNELS;
        channel[4] = (float)(size / network->shape.length);
        channel[5] = sbi_predict_along(network, place);
        channel[6] = 1;
    }
    for (int k = 0; k < input->count; k++) {
        int node = input->nodes ? input->nodes[k] : k;
        float *channel = network->channels + sbi_predict_place(network, grid, node) * SB_NETWORK_CHANNELS;
        sb_vec3 u = input->displacements[k];
        channel[0] = (float)(u.x / size);
        channel[1] = (float)(u.y / size);
        channel[2] = (float)(u.z / size);
        channel[3] = 1;
    }
}

/* network->guess = displacements of the grid's nodes (m), supports where they belong. */
static sb_result sbi_predict_guess(sb_network *network, const sb_grid *grid, const sb_body *body,
                                   const sb_network_input *input, sb_real size, sb_error *error)
{
    if (size > 0) {
        sbi_predict_fill(network, grid, input, size);
        if (sb_network_run(network, network->channels, network->answer) != SB_OK)
            return sbi_fail(error, SB_ERROR_NOT_FINITE, "what the network makes of this input is not finite");
    }
    for (int i = 0; i < grid->mesh.node_count; i++) {
        const float *u = network->answer + 3 * sbi_predict_place(network, grid, i);
        network->guess[i] =
            size > 0 ? sb_v3(size * (sb_real)u[0], size * (sb_real)u[1], size * (sb_real)u[2]) : sb_v3(0, 0, 0);
    }
    sbi_guess_settle(body, network->guess);
    for (int i = 0; i < grid->mesh.node_count; i++)
        if (!sb_v3_is_finite(network->guess[i]))
            return sbi_fail_node(error, SB_ERROR_NOT_FINITE, i, "the guess of node %d is not finite", i);
    return SB_OK;
}

/* ---- what becomes of it ---- */

/* Weighs network->guess into info; 1 when it passes. */
static int sbi_predict_passes(sb_network *network, sb_body *body, sb_network_info *info)
{
    sbi_guess guess;
    guess.force = guess.residual = guess.from_rest = guess.from_last = (sb_real)INFINITY;
    (void)sbi_guess_weigh(body, network->guess, network->scratch, &guess, NULL);
    info->force = guess.force;
    info->residual = guess.residual;
    info->from_rest = guess.from_rest;
    info->from_last = guess.from_last;
    return info->from_rest < 0 && info->from_last < 0 && sb_is_finite(info->force);
}

/* From the guess where it passes; where it does not, or fails, from where the body is. */
static sb_result sbi_predict_solve(sb_network *network, sb_body *body, const sb_network_input *input,
                                   sb_network_info *info)
{
    sb_static_options options = input->statics ? *input->statics : sb_default_static_options();
    sb_result result = sbi_static_check_options(&options, &info->solve.error);
    if (result != SB_OK)
        return result;
    (void)sbi_guess_smooth(body, network->guess, NULL); /* the guess as it is, where that cannot be had */
    if (!sbi_predict_passes(network, body, info))
        return sb_body_solve_static(body, &options, &info->solve);
    memcpy(network->scratch, body->displacement, (size_t)body->domain.node_count * sizeof(sb_vec3));
    result = sb_body_set_displacements(body, network->guess);
    options.start = SB_START_PRESENT;
    if (result == SB_OK)
        result = sb_body_solve_static(body, &options, &info->solve);
    info->taken = result == SB_OK;
    if (info->taken)
        return SB_OK;
    options.start = input->statics ? input->statics->start : SB_START_AUTO;
    (void)sb_body_set_displacements(body, network->scratch);
    return sb_body_solve_static(body, &options, &info->solve);
}

SB_API sb_result sb_network_predict(sb_network *network, const sb_grid *grid, sb_body *body,
                                    const sb_network_input *input, sb_network_info *info, sb_error *error)
{
    sb_network_info own;
    sb_result result = sbi_predict_check(network, grid, body, input, error);
    sb_real size;
    if (result != SB_OK)
        return result;
    info = info ? info : &own;
    size = sbi_predict_size(input);
    result = sbi_predict_guess(network, grid, body, input, size, error);
    if (result != SB_OK)
        return result;
    memset(info, 0, sizeof *info);
    info->size = size;
    if (input->policy != SB_NETWORK_START) {
        int passes = sbi_predict_passes(network, body, info);
        info->taken = input->policy == SB_NETWORK_TAKE && passes && info->residual <= input->limit;
        return info->taken ? sb_body_set_displacements(body, network->guess) : SB_OK;
    }
    result = sbi_predict_solve(network, body, input, info);
    if (result != SB_OK && error)
        *error = info->solve.error;
    return result;
}
