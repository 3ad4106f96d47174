/* cable: ligaments, sutures, threads, tethers and springs of a rest length. */
#include "cable.h"

#include <math.h>
#include <string.h>

#include "cable_law.h"

SB_API sb_cable_def sb_default_cable_def(void)
{
    sb_cable_def def;
    memset(&def, 0, sizeof def);
    return def;
}

/* ---- making ---- */

/* What point k of a def is made of: nodes and weights; 0: it is in space, which a single weight of 0 says too, as
 * recordings have it. */
static int sbi_cable_def_row(const sb_cable_def *def, int k, const int **nodes, const sb_real **weights)
{
    static const sb_real one = 1;
    int count = def->rows ? def->rows->row_start[k + 1] - def->rows->row_start[k] : 0;
    *nodes = def->nodes ? def->nodes + k : NULL;
    *weights = &one;
    if (*nodes && **nodes >= 0)
        return 1;
    *nodes = def->rows ? def->rows->nodes + def->rows->row_start[k] : NULL;
    *weights = def->rows ? def->rows->weights + def->rows->row_start[k] : NULL;
    return count == 1 && **weights == 0 ? 0 : count;
}

static sb_result sbi_cable_check_point(const sb_body *body, const sb_cable_def *def, int k, sb_error *error)
{
    const int *nodes;
    const sb_real *weights;
    int count = sbi_cable_def_row(def, k, &nodes, &weights), start[2] = {0, count};
    double sum = 0;
    sb_mapping row;
    sb_result result;
    if (count == 0 && !def->places)
        return sbi_fail_element(error, SB_ERROR_ARGUMENT, k, "point %d of the cable has no node and no place", k);
    if (count == 0 && !sb_v3_is_finite(def->places[k]))
        return sbi_fail_element(error, SB_ERROR_NOT_FINITE, k, "the place of point %d is not finite", k);
    if (count == 0)
        return SB_OK;
    row.row_count = 1;
    row.row_start = start;
    row.nodes = nodes;
    row.weights = weights;
    result = sbi_load_check_mapping(body, &row, error);
    if (result != SB_OK)
        return sbi_fail_element(error, result, k, "point %d of the cable is no point of the body", k);
    for (int i = 0; i < count; i++)
        sum += (double)weights[i];
    return fabs(sum - 1) < 1e-3 ? SB_OK
                                : sbi_fail_element(error, SB_ERROR_ARGUMENT, k,
                                                   "the weights of point %d of the cable sum up to %g, not 1", k, sum);
}

/* Checks points; *entries: of all rows, *anchor: a node of the body that the cable has, -1: none. */
static sb_result sbi_cable_check_points(const sb_body *body, const sb_cable_def *def, size_t *entries, int *anchor,
                                        sb_error *error)
{
    const sb_mapping *rows = def->rows;
    sb_result result = SB_OK;
    *entries = 0;
    *anchor = -1;
    if (rows && (rows->row_count != def->count || !rows->row_start || rows->row_start[0] != 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a cable of %d points needs as many rows from 0 on", def->count);
    for (int k = 0; rows && k < def->count; k++)
        if (rows->row_start[k + 1] < rows->row_start[k])
            return sbi_fail_element(error, SB_ERROR_ARGUMENT, k, "row %d of the cable descends", k);
    if (rows && rows->row_start[def->count] > 0 && (!rows->nodes || !rows->weights))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the rows of the cable have no nodes or weights");
    for (int k = 0; k < def->count && result == SB_OK; k++) {
        const int *nodes;
        const sb_real *weights;
        int count = sbi_cable_def_row(def, k, &nodes, &weights);
        result = sbi_cable_check_point(body, def, k, error);
        for (int i = 0; i < count && result == SB_OK && *anchor < 0; i++)
            *anchor = weights[i] != 0 ? nodes[i] : -1;
        *entries += (size_t)sbi_max_int(count, 1);
    }
    if (result == SB_OK && *anchor < 0)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "no point of the cable belongs to the body");
    if (result == SB_OK && *entries > INT32_MAX / 4)
        result = sbi_fail(error, SB_ERROR_MEMORY, "%d points of a cable have too many nodes", def->count);
    return result;
}

/* A point in space is a row without weight, at a node that the cable has anyway. */
static void sbi_cable_fill(const sb_cable_def *def, int anchor, sbi_load *load)
{
    int end = 0;
    for (int k = 0; k < def->count; k++) {
        const int *nodes;
        const sb_real *weights;
        int count = sbi_cable_def_row(def, k, &nodes, &weights);
        for (int i = 0; i < count; i++) {
            load->nodes[end] = nodes[i];
            load->weights[end++] = weights[i];
        }
        if (count == 0) {
            load->target[k] = def->places[k];
            load->nodes[end] = anchor;
            load->weights[end++] = 0;
        }
        load->row_start[k + 1] = end;
    }
    load->cable.rest = def->rest_length;
    load->cable.stiffness = def->stiffness;
    load->cable.toe = def->toe_strain;
    load->cable.pushes = def->pushes != 0;
}

/* Puts the rest length in place where the def leaves it to the present points, and checks the whole. */
static sb_result sbi_cable_finish(const sb_body *body, sbi_load *load, sb_error *error)
{
    if (load->cable.rest == 0) {
        load->cable.rest = 1; /* for strains that nobody reads */
        sbi_cable_lay(body, load, body->displacement, 1);
        load->cable.rest = load->lie.length;
    }
    load->balanced_cable = load->cable;
    return sbi_cable_check_law(&load->cable, body->last_load_id + 1, error);
}

/* As the adder takes it, with what it left open. */
static void sbi_cable_tell(sb_body *body, const sbi_load *load)
{
    const sb_real numbers[3] = {load->cable.rest, load->cable.stiffness, load->cable.toe};
    size_t rows = (size_t)load->row_count, entries = (size_t)load->row_start[rows];
    sbi_command command;
    memset(&command, 0, sizeof command);
    command.code = SBI_COMMAND_ADD_CABLE;
    command.a = load->row_count;
    command.b = load->cable.pushes;
    command.ints = load->row_start;
    command.int_count = rows + 1;
    command.more_ints = load->nodes;
    command.more_int_count = entries;
    command.reals = &load->target[0].x;
    command.real_count = 3 * rows;
    command.more_reals[0] = numbers;
    command.more_real_counts[0] = 3;
    command.more_reals[1] = load->weights;
    command.more_real_counts[1] = entries;
    sbi_body_tell_command(body, &command);
}

/* Adds a load that was made. */
static sb_result sbi_cable_add(sb_body *body, sbi_load *load, int *load_id, sb_error *error)
{
    sb_result result = sbi_cable_finish(body, load, error);
    if (result == SB_OK)
        result = sbi_load_reserve(body, error);
    if (result == SB_OK)
        result = sbi_load_couple(body, load, error);
    if (result != SB_OK) {
        sbi_load_release(&body->allocator, load);
        return result;
    }
    sbi_load_append(body, load, load_id);
    sbi_cable_tell(body, load);
    return SB_OK;
}

SB_API sb_result sb_body_add_cable(sb_body *body, const sb_cable_def *def, int *load_id, sb_error *error)
{
    size_t entries;
    int anchor;
    sbi_load load;
    sb_result result;
    if (!body || !def || def->count < 2)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_add_cable needs a body and at least 2 points");
    result = sbi_cable_check_points(body, def, &entries, &anchor, error);
    if (result == SB_OK)
        result = sbi_load_make(&body->allocator, SBI_LOAD_CABLE, def->count, (int)entries, 0, &load, error);
    if (result != SB_OK)
        return result;
    sbi_cable_fill(def, anchor, &load);
    return sbi_cable_add(body, &load, load_id, error);
}

/* ---- changing ---- */

static sb_result sbi_cable_set(sb_body *body, int load_id, const sb_real *rest, const sb_real *stiffness)
{
    sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_CABLE);
    sbi_cable_law law;
    sb_real numbers[2];
    sb_result result;
    if (!body)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    law = load->cable;
    law.rest = rest ? *rest : law.rest;
    law.stiffness = stiffness ? *stiffness : law.stiffness;
    result = sbi_cable_check_law(&law, load_id, NULL);
    if (result != SB_OK)
        return result;
    body->guard.stable_step = 0;
    load->cable = law;
    numbers[0] = law.rest;
    numbers[1] = law.stiffness;
    sbi_body_tell(body, SBI_COMMAND_CABLE, load_id, 0, NULL, 0, numbers, 2);
    return SB_OK;
}

SB_API sb_result sb_body_set_cable_rest_length(sb_body *body, int load_id, sb_real rest_length)
{
    return sbi_cable_set(body, load_id, &rest_length, NULL);
}

SB_API sb_result sb_body_set_cable_stiffness(sb_body *body, int load_id, sb_real stiffness)
{
    return sbi_cable_set(body, load_id, NULL, &stiffness);
}

SB_API sb_result sb_body_move_cable(sb_body *body, int load_id, const sb_vec3 *places)
{
    sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_CABLE);
    if (!body || !places)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    for (int k = 0; k < load->row_count; k++)
        if (sbi_cable_point_is_in_space(load, k) && !sb_v3_is_finite(places[k]))
            return SB_ERROR_NOT_FINITE;
    for (int k = 0; k < load->row_count; k++)
        if (sbi_cable_point_is_in_space(load, k))
            load->target[k] = places[k];
    sbi_body_tell(body, SBI_COMMAND_POINTS, load_id, SBI_LOAD_CABLE, NULL, 0, &load->target[0].x,
                  3 * (size_t)load->row_count);
    return SB_OK;
}

/* ---- readings ---- */

SB_API sb_result sb_body_cable_tension(const sb_body *body, int load_id, sb_real *tension)
{
    const sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_CABLE);
    if (!body || !tension)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    *tension = load->tension;
    return SB_OK;
}

SB_API sb_result sb_body_cable_length(const sb_body *body, int load_id, sb_real *length)
{
    const sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_CABLE);
    sb_vec3 before;
    if (!body || !length)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    *length = 0;
    before = sbi_cable_point(body, load, 0, body->displacement, 1);
    for (int k = 1; k < load->row_count; k++) {
        sb_vec3 at = sbi_cable_point(body, load, k, body->displacement, 1);
        *length += sb_v3_norm(sb_v3_sub(at, before));
        before = at;
    }
    return SB_OK;
}

SB_API sb_result sb_body_cable_points(const sb_body *body, int load_id, sb_vec3 *points)
{
    const sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_CABLE);
    if (!body || !points)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    for (int k = 0; k < load->row_count; k++)
        points[k] = sbi_cable_point(body, load, k, body->displacement, 1);
    return SB_OK;
}

SB_API sb_result sb_body_cable_forces(const sb_body *body, int load_id, sb_vec3 *forces)
{
    const sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_CABLE);
    if (!body || !forces)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    memcpy(forces, load->force, (size_t)load->row_count * sizeof *forces);
    return SB_OK;
}
