/* cavity: hollows of a body and what fills them. */
#include "cavity.h"

#include <string.h>

#include "cavity_law.h"
#include "step.h"

SB_API sb_cavity_def sb_default_cavity_def(void)
{
    sb_cavity_def def;
    memset(&def, 0, sizeof def);
    def.corners = 3;
    def.ambient = 101325;
    def.exponent = 1;
    def.bulk = (sb_real)2.2e9;
    return def;
}

/* ---- making ---- */

/* What the def says, filled to the present volume. */
static void sbi_cavity_fill(const sb_cavity_def *def, sb_real volume, sbi_cavity *cavity)
{
    int points = def->kind == SB_CAVITY_TABLE ? def->point_count : 0;
    cavity->law.kind = def->kind;
    cavity->law.pressure = def->pressure;
    cavity->law.ambient = def->ambient;
    cavity->law.exponent = def->exponent;
    cavity->law.bulk = def->bulk;
    cavity->law.filled = def->kind == SB_CAVITY_TABLE ? 0 : volume;
    cavity->law.share = 1;
    cavity->balanced = cavity->law;
    cavity->point_count = points;
    for (int k = 0; k < points && k < SB_MAX_CAVITY_POINTS; k++) {
        cavity->table_volume[k] = def->table_volume[k];
        cavity->table_pressure[k] = def->table_pressure[k];
    }
    cavity->hold.pressure = def->kind == SB_CAVITY_LIQUID ? def->pressure : 0;
}

/* Rims, volume and law of a load whose faces are there. */
static sb_result sbi_cavity_finish(const sb_body *body, const sb_cavity_def *def, sbi_load *load, sb_error *error)
{
    sb_real volume;
    sb_result result = sbi_cavity_find_rims(body, load, error);
    if (result == SB_OK && load->has_parts)
        result = sbi_fail_node(error, SB_ERROR_UNSUPPORTED, load->nodes[0], "a face of the cavity is cut through");
    if (result != SB_OK)
        return result;
    sbi_cavity_lay(body, load, body->displacement, 1);
    volume = (sb_real)load->cavity.volume;
    if (!(volume > 0) && def->kind != SB_CAVITY_PRESSURE && def->kind != SB_CAVITY_TABLE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the cavity's volume is %g m^3: its faces are to look into it",
                        (double)volume);
    sbi_cavity_fill(def, volume, &load->cavity);
    return sbi_cavity_check_law(&load->cavity, &load->cavity.law, error);
}

/* As the adder takes it. */
static void sbi_cavity_tell(sb_body *body, const sb_cavity_def *def, const sbi_cavity *cavity)
{
    const sb_real numbers[4] = {def->pressure, def->ambient, def->exponent, def->bulk};
    size_t points = (size_t)cavity->point_count;
    sb_real table[2 * SB_MAX_CAVITY_POINTS];
    sbi_command command;
    memset(&command, 0, sizeof command);
    memcpy(table, cavity->table_volume, points * sizeof(sb_real));
    memcpy(table + points, cavity->table_pressure, points * sizeof(sb_real));
    command.code = SBI_COMMAND_ADD_CAVITY;
    command.a = def->corners;
    command.b = (int)def->kind;
    command.ints = def->faces;
    command.int_count = (size_t)def->face_count * (size_t)def->corners;
    command.reals = numbers;
    command.real_count = 4;
    command.more_reals[0] = table;
    command.more_real_counts[0] = 2 * points;
    sbi_body_tell_command(body, &command);
}

/* Numbers that are not used have to be numbers, too: they are recorded. */
static sb_result sbi_cavity_check_def(const sb_body *body, const sb_cavity_def *def, sb_error *error)
{
    if (!body || !def || !def->faces || def->face_count < 1 || def->corners < 3 || def->corners > 4)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_add_cavity needs a body, and faces of 3 or 4 corners");
    if ((int)def->kind < SB_CAVITY_PRESSURE || (int)def->kind > SB_CAVITY_TABLE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a cavity has the unknown kind %d", (int)def->kind);
    if (def->kind == SB_CAVITY_TABLE && (def->point_count < 2 || def->point_count > SB_MAX_CAVITY_POINTS))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a cavity's table has %d points", def->point_count);
    if (!sb_is_finite(def->pressure) || !sb_is_finite(def->ambient) || !sb_is_finite(def->exponent) ||
        !sb_is_finite(def->bulk))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "pressure, exponent or modulus of a cavity is not finite");
    return SB_OK;
}

SB_API sb_result sb_body_add_cavity(sb_body *body, const sb_cavity_def *def, int *load_id, sb_error *error)
{
    sbi_load load;
    sb_real stable;
    sb_result result = sbi_cavity_check_def(body, def, error);
    if (result == SB_OK)
        result = sbi_load_make_faces(body, SBI_LOAD_CAVITY, def->faces, def->face_count, def->corners, &load, error);
    if (result != SB_OK)
        return result;
    result = sbi_cavity_finish(body, def, &load, error);
    if (result == SB_OK)
        result = sbi_load_reserve(body, error);
    if (result != SB_OK) {
        sbi_load_release(&body->allocator, &load);
        return result;
    }
    sbi_load_append(body, &load, load_id);
    if (body->integrator == SB_CENTRAL_DIFFERENCE && sbi_cavity_is_stiff(&load)) /* forces of the first step have it */
        (void)sb_body_stable_step(body, &stable, NULL);
    sbi_cavity_tell(body, def, &load.cavity);
    return SB_OK;
}

/* ---- changing ---- */

SBI_API sb_result sbi_cavity_set(sb_body *body, int load_id, sb_real pressure, sb_real filled)
{
    sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_CAVITY);
    const sb_real numbers[2] = {pressure, filled};
    sbi_cavity_law law;
    sb_result result;
    if (!load)
        return SB_ERROR_INDEX;
    law = load->cavity.law;
    law.pressure = pressure;
    law.filled = filled;
    result = sbi_cavity_check_law(&load->cavity, &law, NULL);
    if (result != SB_OK)
        return result;
    body->guard.stable_step = 0;
    load->cavity.law = law;
    sbi_body_tell(body, SBI_COMMAND_CAVITY, load_id, 0, NULL, 0, numbers, 2);
    return SB_OK;
}

SB_API sb_result sb_body_inject_cavity(sb_body *body, int load_id, sb_real volume)
{
    const sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_CAVITY);
    if (!body)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    if (!sb_is_finite(volume))
        return SB_ERROR_NOT_FINITE;
    if (load->cavity.law.kind == SB_CAVITY_PRESSURE)
        return SB_ERROR_ARGUMENT;
    return sbi_cavity_set(body, load_id, load->cavity.law.pressure, load->cavity.law.filled + volume);
}

SB_API sb_result sb_body_set_cavity_pressure(sb_body *body, int load_id, sb_real pressure)
{
    const sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_CAVITY);
    if (!body)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    if (load->cavity.law.kind != SB_CAVITY_PRESSURE)
        return SB_ERROR_ARGUMENT;
    return sbi_cavity_set(body, load_id, pressure, load->cavity.law.filled);
}

/* ---- readings ---- */

SB_API sb_result sb_body_cavity_volume(sb_body *body, int load_id, sb_real *volume)
{
    sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_CAVITY);
    if (!body || !volume)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    sbi_cavity_lay(body, load, body->displacement, 1);
    *volume = (sb_real)load->cavity.volume;
    return SB_OK;
}

SB_API sb_result sb_body_cavity_pressure(const sb_body *body, int load_id, sb_real *pressure)
{
    const sbi_load *load = sbi_load_find(body, load_id, SBI_LOAD_CAVITY);
    if (!body || !pressure)
        return SB_ERROR_ARGUMENT;
    if (!load)
        return SB_ERROR_INDEX;
    *pressure = load->cavity.read;
    return SB_OK;
}
