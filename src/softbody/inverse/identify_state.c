/* identify_state: values go into the body, states are solved, readings and their derivatives come out. */
#include <math.h>
#include <string.h>

#include "identify_private.h"

enum { SBI_WAY_PLAIN = 0, SBI_WAY_LOG = 1, SBI_WAY_HALF = 2 };

SBI_API int sbi_identify_way(const sbi_identify *id, int k)
{
    sb_parameter_kind kind = k < id->def->count ? id->def->parameters[k].kind : SB_PARAMETER_YOUNG;
    if (kind == SB_PARAMETER_POISSON)
        return SBI_WAY_HALF;
    return kind == SB_PARAMETER_GRAVITY || kind == SB_PARAMETER_FORCE || kind == SB_PARAMETER_PRESSURE ? SBI_WAY_PLAIN
                                                                                                       : SBI_WAY_LOG;
}

SBI_API double sbi_identify_rate(const sbi_identify *id, int k, double p)
{
    int way = sbi_identify_way(id, k);
    return way == SBI_WAY_LOG ? p : way == SBI_WAY_HALF ? p * (1 - 2 * p) : 1;
}

SBI_API double sbi_identify_room(const sbi_identify *id, int k, double p, int side)
{
    const sb_real *bounds = side > 0 ? id->def->high : id->def->low;
    int way = sbi_identify_way(id, k);
    double bound = bounds ? (double)bounds[k] : side * (double)INFINITY;
    if (way == SBI_WAY_PLAIN)
        return bound - p;
    if (!(bound > 0) || (way == SBI_WAY_HALF && !(bound < 0.5)) || isinf(bound))
        return side * (double)INFINITY;
    return log(bound / p) - (way == SBI_WAY_HALF ? log((1 - 2 * bound) / (1 - 2 * p)) : 0);
}

SBI_API double sbi_identify_move(const sbi_identify *id, int k, double p, double dq)
{
    int way = sbi_identify_way(id, k), side = dq > 0 ? 1 : -1;
    double moved = p + dq;
    if (dq != 0 && dq * side >= sbi_identify_room(id, k, p, side) * side)
        return (double)(side > 0 ? id->def->high : id->def->low)[k];
    if (way == SBI_WAY_LOG)
        moved = p * exp(dq);
    if (way == SBI_WAY_HALF) /* 2 p / (1 - 2 p) = exp(q) */
        moved = p * exp(dq) / (1 - 2 * p + 2 * p * exp(dq));
    if (id->def->low)
        moved = fmax(moved, (double)id->def->low[k]);
    if (id->def->high)
        moved = fmin(moved, (double)id->def->high[k]);
    return moved;
}

/* ---- values into the body ---- */

static const sb_parameter *sbi_identify_find(const sbi_identify *id, sb_parameter_kind kind, int region, int *k)
{
    for (*k = 0; *k < id->def->count; (*k)++)
        if (id->def->parameters[*k].kind == kind && id->def->parameters[*k].region == region)
            return id->def->parameters + *k;
    return NULL;
}

/* The material of a region with these values. */
static sb_material sbi_identify_material(const sbi_identify *id, int index, const sb_real *values)
{
    sb_material m = id->materials[index];
    int region = id->body->material_regions[index], k;
    sb_real young = sb_material_young(&m), poisson = sb_material_poisson(&m);
    int has_young = sbi_identify_find(id, SB_PARAMETER_YOUNG, region, &k) != NULL;
    if (has_young)
        young = values[k];
    if (sbi_identify_find(id, SB_PARAMETER_POISSON, region, &k)) {
        poisson = values[k];
        has_young = 1;
    }
    if (has_young)
        sbi_material_set_moduli(&m, young, poisson);
    for (k = 0; k < id->def->count; k++)
        if (id->def->parameters[k].kind == SB_PARAMETER_CONSTANT && id->def->parameters[k].region == region)
            sbi_material_set_constant(&m, id->def->parameters[k].constant, values[k]);
    if (sbi_identify_find(id, SB_PARAMETER_DENSITY, region, &k))
        m.density = values[k];
    return m;
}

static int sbi_identify_names_region(const sbi_identify *id, int region)
{
    int k;
    for (int kind = SB_PARAMETER_YOUNG; kind <= SB_PARAMETER_DENSITY; kind++)
        if (sbi_identify_find(id, (sb_parameter_kind)kind, region, &k))
            return 1;
    return 0;
}

static sb_result sbi_identify_set_materials(sbi_identify *id, const sb_real *values)
{
    sb_result result = SB_OK;
    for (int i = 0; i < id->body->material_count && result == SB_OK; i++) {
        int region = id->body->material_regions[i];
        sb_material m = sbi_identify_material(id, i, values);
        if (sbi_identify_names_region(id, region))
            result = sb_body_set_region_material(id->body, region, &m, id->error);
    }
    return result;
}

static sb_vec3 sbi_identify_along(int axis, sb_real value, sb_vec3 others)
{
    return sb_v3(axis == 0 ? value : others.x, axis == 1 ? value : others.y, axis == 2 ? value : others.z);
}

static sb_result sbi_identify_set_stiffness(sb_body *b, int load_id, const sb_real *stiffness, int uniform)
{
    if (sb_body_set_spring_stiffness(b, load_id, stiffness, uniform) == SB_OK)
        return SB_OK;
    return sb_body_set_mapping_stiffness(b, load_id, stiffness, uniform);
}

static sb_result sbi_identify_add_force(sbi_identify *id, int k, sb_real value)
{
    const sb_parameter *p = id->def->parameters + k;
    sb_vec3 force = sbi_identify_along(p->axis, value, sb_v3(0, 0, 0));
    sb_result result = sb_body_apply_forces(id->body, p->nodes, p->node_count, &force, 1, id->error);
    if (result == SB_OK)
        id->applied[k] = value;
    return result;
}

/* Forces that are sought leave the dead loads, to rounding. */
static void sbi_identify_take_forces(sbi_identify *id)
{
    for (int k = 0; k < id->def->count; k++) {
        if (id->applied[k] != 0)
            (void)sbi_identify_add_force(id, k, -id->applied[k]);
        id->applied[k] = 0;
    }
}

static sb_result sbi_identify_set_load(sbi_identify *id, int k, sb_real value)
{
    const sb_parameter *p = id->def->parameters + k;
    sb_body *b = id->body;
    sb_result result = SB_OK;
    switch (p->kind) {
    case SB_PARAMETER_GRAVITY: return sb_body_set_gravity(b, sbi_identify_along(p->axis, value, b->gravity));
    case SB_PARAMETER_FORCE: return sbi_identify_add_force(id, k, value);
    case SB_PARAMETER_PRESSURE: result = sb_body_set_pressure(b, p->load_id, value); break;
    case SB_PARAMETER_STIFFNESS: result = sbi_identify_set_stiffness(b, p->load_id, &value, 1); break;
    default: break;
    }
    return result == SB_OK
               ? result
               : sbi_fail(id->error, result, "parameter %d: load %d cannot be set to %g", k, p->load_id, (double)value);
}

/* ---- what the body had ---- */

static int sbi_identify_row_count(const sb_body *b, const sb_parameter *p)
{
    const sbi_load *load = p->kind == SB_PARAMETER_STIFFNESS ? sbi_loads_get(b, p->load_id) : NULL;
    return load ? load->row_count : 0;
}

SBI_API size_t sbi_identify_rows(const sb_identify_def *def)
{
    size_t rows = 0;
    for (int k = 0; k < def->count; k++)
        rows += (size_t)sbi_identify_row_count(def->body, def->parameters + k);
    return rows;
}

SBI_API void sbi_identify_keep(sbi_identify *id)
{
    const sb_body *b = id->body;
    sb_real *rows = id->stiffness;
    memcpy(id->materials, b->materials, (size_t)b->material_count * sizeof *id->materials);
    memcpy(id->start, b->displacement, (size_t)id->nodes * sizeof *id->start);
    for (int k = 0; k < id->def->count; k++) {
        const sb_parameter *p = id->def->parameters + k;
        int count = sbi_identify_row_count(b, p);
        if (p->kind == SB_PARAMETER_GRAVITY)
            id->loads[k] = p->axis == 0 ? b->gravity.x : p->axis == 1 ? b->gravity.y : b->gravity.z;
        if (p->kind == SB_PARAMETER_PRESSURE)
            id->loads[k] = sbi_loads_get(b, p->load_id)->pressure;
        if (count > 0)
            memcpy(rows, sbi_loads_get(b, p->load_id)->stiffness, (size_t)count * sizeof *rows);
        rows += count;
    }
}

static void sbi_identify_restore_loads(sbi_identify *id)
{
    const sb_real *rows = id->stiffness;
    sb_error *error = id->error; /* a load that `apply` has removed stays so */
    id->error = NULL;
    sbi_identify_take_forces(id);
    for (int k = 0; k < id->def->count; k++) {
        const sb_parameter *p = id->def->parameters + k;
        int count = sbi_identify_row_count(id->body, p);
        if (p->kind == SB_PARAMETER_GRAVITY || p->kind == SB_PARAMETER_PRESSURE)
            (void)sbi_identify_set_load(id, k, id->loads[k]);
        if (count > 0)
            (void)sbi_identify_set_stiffness(id->body, p->load_id, rows, 0);
        rows += count;
    }
    id->error = error;
}

SBI_API void sbi_identify_restore(sbi_identify *id)
{
    sbi_identify_restore_loads(id);
    for (int i = 0; i < id->body->material_count; i++)
        if (sbi_identify_names_region(id, id->body->material_regions[i]))
            (void)sb_body_set_region_material(id->body, id->body->material_regions[i], id->materials + i, NULL);
    (void)sb_body_set_displacements(id->body, id->start);
}

/* ---- one state ---- */

static sb_result sbi_identify_solve(sbi_identify *id, int state, const sb_real *values)
{
    const sb_identify_def *def = id->def;
    sb_step_info info;
    sb_result result = SB_OK;
    sbi_identify_take_forces(id);
    if (def->apply)
        result = def->apply(def->user, state, values + def->count, id->body, id->error);
    if (result != SB_OK && id->error && id->error->result != result)
        return sbi_fail(id->error, result, "def.apply returned %d (%s) for state %d", (int)result,
                        sb_result_string(result), state);
    for (int k = 0; k < def->count && result == SB_OK; k++)
        result = sbi_identify_set_load(id, k, values[k]);
    if (result == SB_OK)
        result = sb_body_set_displacements(id->body, id->shapes + (size_t)state * (size_t)id->nodes);
    if (result != SB_OK)
        return result;
    id->info.solves++;
    result = sb_body_solve_static(id->body, &def->statics, &info);
    if (result != SB_OK && id->error)
        *id->error = info.error;
    return result;
}

static double sbi_identify_axis(sb_vec3 v, int axis) { return (double)(axis == 0 ? v.x : axis == 1 ? v.y : v.z); }

/* What a state's readings are of a vector by node, or (positions) of where nodes are: out[readings of the state] over
 * sigma; those of points by u, those of forces by r. Returns how many. */
static int sbi_identify_read(const sb_measurement *m, const sb_vec3 *u, const sb_vec3 *r, double *out)
{
    int count = 0;
    for (int j = 0; m->rows && j < m->rows->row_count; j++) {
        sb_vec3 at = sb_v3(0, 0, 0);
        for (int k = m->rows->row_start[j]; u && k < m->rows->row_start[j + 1]; k++)
            at = sb_v3_madd(at, m->rows->weights[k], u[m->rows->nodes[k]]);
        for (int axis = 0; axis < 3; axis++)
            if (!isnan(sbi_identify_axis(m->points[j], axis)))
                out[count++] = sbi_identify_axis(at, axis) / (double)m->sigma_point;
    }
    for (int axis = 0; axis < 3 && m->force_count > 0; axis++) {
        double sum = 0;
        if (isnan(sbi_identify_axis(m->force, axis)))
            continue;
        for (int k = 0; r && k < m->force_count; k++)
            sum += sbi_identify_axis(r[m->force_nodes[k]], axis);
        out[count++] = sum / (double)m->sigma_force;
    }
    return count;
}

/* misfit -= readings / sigma of a state. Returns how many. */
static int sbi_identify_subtract(const sb_measurement *m, double *misfit)
{
    int count = 0;
    for (int j = 0; m->rows && j < m->rows->row_count; j++)
        for (int axis = 0; axis < 3; axis++)
            if (!isnan(sbi_identify_axis(m->points[j], axis)))
                misfit[count++] -= sbi_identify_axis(m->points[j], axis) / (double)m->sigma_point;
    for (int axis = 0; axis < 3 && m->force_count > 0; axis++)
        if (!isnan(sbi_identify_axis(m->force, axis)))
            misfit[count++] -= sbi_identify_axis(m->force, axis) / (double)m->sigma_force;
    return count;
}

SBI_API void sbi_identify_subtract_all(const sbi_identify *id, double *misfit)
{
    for (int state = 0; state < id->def->state_count; state++)
        misfit += sbi_identify_subtract(id->def->measurements + state, misfit);
}

/* Solves one state; *count readings into misfit. */
static sb_result sbi_identify_misfit(sbi_identify *id, int state, const sb_real *values, double *misfit, int *count)
{
    const sb_measurement *m = id->def->measurements + state;
    sb_result result = sbi_identify_solve(id, state, values);
    if (result != SB_OK)
        return result;
    *count = sbi_identify_read(m, id->body->position, id->body->reaction, misfit);
    (void)sbi_identify_subtract(m, misfit);
    return SB_OK;
}

static sb_result sbi_identify_derive(sbi_identify *id, int state, const sb_real *values, int first, double *column)
{
    const sb_identify_def *def = id->def;
    const sb_measurement *m = def->measurements + state;
    sb_result result;
    if (def->count == 0)
        return SB_OK;
    result = sbi_sensitivities_quick(id->body, def->parameters, def->count, id->du,
                                     m->force_count > 0 ? id->dreaction : NULL, id->error);
    for (int k = 0; k < def->count && result == SB_OK; k++) {
        const sb_vec3 *du = id->du + (size_t)k * (size_t)id->nodes;
        const sb_vec3 *dr = m->force_count > 0 ? id->dreaction + (size_t)k * (size_t)id->nodes : NULL;
        double rate = sbi_identify_rate(id, k, (double)values[k]);
        int count = sbi_identify_read(m, du, dr, column);
        for (int i = 0; i < count; i++)
            id->new_slopes[(size_t)(first + i) * (size_t)id->count + (size_t)k] = rate * column[i];
    }
    return result;
}

/* Differences by the free values, central where bounds leave room. */
static sb_result sbi_identify_difference(sbi_identify *id, int state, const sb_real *values, int first, double *column)
{
    const double h = SB_EPSILON > (sb_real)1e-10 ? 3e-2 : 1e-3;
    sb_result result = SB_OK;
    for (int k = id->def->count; k < id->count; k++) {
        sb_real above = (sb_real)sbi_identify_move(id, k, (double)values[k], h);
        sb_real below = (sb_real)sbi_identify_move(id, k, (double)values[k], -h);
        double share = above > below ? 1 / log((double)above / (double)below) : 0;
        for (int side = 0; side < 2; side++, share = -share) {
            int count = 0;
            memcpy(id->trial, values, (size_t)id->count * sizeof *values);
            id->trial[k] = side ? below : above;
            result = sbi_identify_misfit(id, state, id->trial, column, &count);
            if (result != SB_OK)
                return result;
            for (int i = 0; i < count; i++) {
                double *slope = id->new_slopes + (size_t)(first + i) * (size_t)id->count + (size_t)k;
                *slope = (side ? *slope : 0) + share * column[i];
            }
        }
    }
    return SB_OK;
}

SBI_API sb_result sbi_identify_evaluate(sbi_identify *id, const sb_real *values)
{
    size_t bytes = (size_t)id->nodes * sizeof(sb_vec3);
    double *column = id->new_misfit + id->readings; /* as much again, as scratch */
    sb_result result = sbi_identify_set_materials(id, values);
    int first = 0, count = 0;
    for (int state = 0; state < id->def->state_count && result == SB_OK; state++, first += count) {
        if (id->count > id->def->count)
            result = sbi_identify_difference(id, state, values, first, column);
        if (result == SB_OK)
            result = sbi_identify_misfit(id, state, values, id->new_misfit + first, &count);
        if (result == SB_OK)
            result = sbi_identify_derive(id, state, values, first, column);
        if (result == SB_OK)
            memcpy(id->new_shapes + (size_t)state * (size_t)id->nodes, id->body->displacement, bytes);
    }
    return result;
}
