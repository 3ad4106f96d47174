/* parameter: dr/dp of each kind of parameter at constant displacements: exact, since stresses are linear in constants.
 */
#include <math.h>
#include <string.h>

#include "equilibrium.h"

/* ---- materials ---- */

static int sbi_model_is_isochoric(sb_material_model model)
{
    return model == SB_NEO_HOOKEAN_ISOCHORIC || model >= SB_MOONEY_RIVLIN;
}

/* D1 times a factor > 0; a law without a bulk term has the largest of numbers, and keeps it. */
static sb_real sbi_material_d1(const sb_material *material, sb_real factor)
{
    return material->d1 / SB_REAL_MAX < 1 / factor ? factor * material->d1 : SB_REAL_MAX;
}

/* A material of the same model and exponents whose stress is 0. */
static sb_material sbi_material_null(const sb_material *material)
{
    sb_material m = *material;
    m.lambda = m.mu = m.c10 = m.c01 = m.c20 = m.c30 = 0;
    m.d1 = SB_REAL_MAX; /* its reciprocal is what counts */
    memset(m.ogden_mu, 0, sizeof m.ogden_mu);
    m.fibre_stiffness = m.fibre_tension = m.law_scale = 0;
    return m;
}

/* The model without fibres: all whose stress is proportional to the shear modulus times `shear`, with lambda (Pa) and
 * the D1 (1/Pa) of a bulk modulus. */
static sb_material sbi_material_change(const sb_material *material, sb_real shear, sb_real lambda, sb_real d1)
{
    sb_material m = sbi_material_null(material);
    m.mu = shear * material->mu;
    m.lambda = lambda;
    m.c10 = shear * material->c10;
    m.c01 = shear * material->c01;
    m.c20 = shear * material->c20;
    m.c30 = shear * material->c30;
    for (int i = 0; i < SB_MAX_OGDEN_TERMS; i++)
        m.ogden_mu[i] = shear * material->ogden_mu[i];
    m.law_scale = shear * material->law_scale;
    m.d1 = d1;
    return m;
}

/* With E at constant nu. */
static sb_material sbi_material_by_young(const sb_material *material)
{
    sb_real young = sb_material_young(material);
    return sbi_material_change(material, 1 / young, material->lambda / young, sbi_material_d1(material, young));
}

/* With nu at constant E: mu = E / (2 (1 + nu)), lambda = E nu / ((1 + nu)(1 - 2 nu)), bulk = E / (3 (1 - 2 nu)). */
static sb_material sbi_material_by_poisson(const sb_material *material)
{
    sb_real young = sb_material_young(material), nu = sb_material_poisson(material);
    sb_real more = 1 + nu, less = 1 - 2 * nu;
    return sbi_material_change(material, -1 / more, young * (1 + 2 * nu * nu) / (more * more * less * less),
                               3 * less * less / young);
}

/* Where a material keeps a constant, or NULL when its stress does not depend on it. */
static sb_real *sbi_material_constant(sb_material *m, int constant)
{
    int isochoric = sbi_model_is_isochoric(m->model), term = constant - SB_CONSTANT_OGDEN_MU;
    switch (constant) {
    case SB_CONSTANT_LAMBDA: return isochoric ? NULL : &m->lambda;
    case SB_CONSTANT_MU: return isochoric ? NULL : &m->mu;
    case SB_CONSTANT_C10: return isochoric && m->model != SB_OGDEN && m->model != SB_CUSTOM_LAW ? &m->c10 : NULL;
    case SB_CONSTANT_C01: return m->model == SB_MOONEY_RIVLIN ? &m->c01 : NULL;
    case SB_CONSTANT_C20: return m->model == SB_REDUCED_POLYNOMIAL ? &m->c20 : NULL;
    case SB_CONSTANT_C30: return m->model == SB_REDUCED_POLYNOMIAL ? &m->c30 : NULL;
    case SB_CONSTANT_D1: return isochoric ? &m->d1 : NULL;
    case SB_CONSTANT_FIBRE_STIFFNESS: return m->fibre_stiffness > 0 ? &m->fibre_stiffness : NULL;
    case SB_CONSTANT_FIBRE_TENSION: return sbi_material_has_fibres(m) ? &m->fibre_tension : NULL;
    default: break;
    }
    if (m->model != SB_OGDEN || term < 0 || term >= SB_MAX_OGDEN_TERMS || m->ogden_mu[term] == 0)
        return NULL;
    return &m->ogden_mu[term];
}

/* With one constant. */
static sb_material sbi_material_by_constant(const sb_material *material, int constant)
{
    sb_material known = *material, m = sbi_material_null(material);
    size_t offset = (size_t)((char *)sbi_material_constant(&known, constant) - (char *)&known);
    const sb_real one = 1;
    memcpy((char *)&m + offset, &one, sizeof one);
    return m;
}

SBI_API void sbi_material_set_moduli(sb_material *m, sb_real young, sb_real poisson)
{
    sb_real before = sb_material_bulk(m), mu = young / (2 * (1 + poisson)), bulk = young / (3 * (1 - 2 * poisson));
    sb_real shear = mu / m->mu;
    m->mu = mu;
    m->lambda = bulk - 2 * mu / 3;
    m->c10 *= shear;
    m->c01 *= shear;
    m->c20 *= shear;
    m->c30 *= shear;
    for (int i = 0; i < SB_MAX_OGDEN_TERMS; i++)
        m->ogden_mu[i] *= shear;
    m->law_scale *= shear;
    m->d1 = sbi_material_d1(m, before / bulk);
}

SBI_API void sbi_material_set_constant(sb_material *m, int constant, sb_real value)
{
    sb_real bulk = sb_material_bulk(m) - 2 / m->d1;
    *sbi_material_constant(m, constant) = value;
    if (!sbi_model_is_isochoric(m->model)) {
        m->c10 = m->mu / 2;
        m->d1 = 2 / sb_material_bulk(m);
        return;
    }
    if (m->model == SB_OGDEN) {
        m->c10 = 0;
        for (int i = 0; i < SB_MAX_OGDEN_TERMS; i++)
            m->c10 += m->ogden_mu[i] * m->ogden_alpha[i] / 4;
    }
    if (m->model != SB_CUSTOM_LAW)
        m->mu = 2 * (m->c10 + m->c01);
    m->lambda = bulk + 2 / m->d1 - 2 * m->mu / 3;
}

/* What the relaxed stress of a material changes by, as a material; *factor is to be multiplied by. */
static sb_material sbi_parameter_material(const sb_parameter *p, const sb_material *material, sb_real *factor)
{
    sb_material change;
    *factor = 1;
    if (p->kind == SB_PARAMETER_YOUNG)
        change = sbi_material_by_young(material);
    else if (p->kind == SB_PARAMETER_POISSON)
        change = sbi_material_by_poisson(material);
    else
        change = sbi_material_by_constant(material, p->constant);
    if (p->kind == SB_PARAMETER_CONSTANT && p->constant == SB_CONSTANT_D1)
        *factor = -1 / (material->d1 * material->d1);
    if (material->prony_count > 0)
        change = sbi_material_relaxed(&change, sbi_prony_factor(material, (sb_real)INFINITY));
    change.prony_count = 0;
    return change;
}

static int sbi_parameter_is_of_material(sb_parameter_kind kind)
{
    return kind == SB_PARAMETER_YOUNG || kind == SB_PARAMETER_POISSON || kind == SB_PARAMETER_CONSTANT;
}

/* ---- checks ---- */

static sb_result sbi_parameter_check_region(const sb_body *body, const sb_parameter *p, int k, sb_error *error)
{
    int found, at = sbi_body_find_region(body->material_regions, body->material_count, p->region, &found);
    sb_material material;
    if (!found)
        return sbi_fail(error, SB_ERROR_INDEX, "parameter %d: the mesh has no region %d", k, p->region);
    if (body->live)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "parameter %d: the mesh of the body may change, which has no derivatives by its elements", k);
    material = body->materials[at];
    if (p->kind == SB_PARAMETER_POISSON && material.model == SB_CUSTOM_LAW)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "parameter %d: how a law of one's own depends on Poisson's ratio is not known", k);
    if (p->kind == SB_PARAMETER_CONSTANT && !sbi_material_constant(&material, p->constant))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "parameter %d: the material of region %d has no constant %d", k,
                        p->region, p->constant);
    return SB_OK;
}

static sb_result sbi_parameter_check_load(const sb_body *body, const sb_parameter *p, int k, sb_error *error)
{
    const sbi_load *load = sbi_loads_get(body, p->load_id);
    int presses = p->kind == SB_PARAMETER_PRESSURE;
    if (!load || (load->kind == SBI_LOAD_PRESSURE) != presses || (!presses && !load->stiffness) ||
        load->kind == SBI_LOAD_POTENTIAL || load->kind == SBI_LOAD_CABLE)
        return sbi_fail(error, SB_ERROR_INDEX, "parameter %d: there is no %s %d", k,
                        presses ? "pressure" : "spring or mapping", p->load_id);
    if (!presses && p->row != SB_AUTO && (p->row < 0 || p->row >= load->row_count))
        return sbi_fail(error, SB_ERROR_INDEX, "parameter %d: load %d has no row %d", k, p->load_id, p->row);
    return SB_OK;
}

static sb_result sbi_parameter_check_nodes(const sb_body *body, const sb_parameter *p, int k, sb_error *error)
{
    if (!p->nodes || p->node_count < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "parameter %d needs nodes", k);
    for (int i = 0; i < p->node_count; i++) {
        int node = p->nodes[i];
        if (node < 0 || node >= body->domain.node_count)
            return sbi_fail_node(error, SB_ERROR_INDEX, node, "parameter %d: there is no node %d", k, node);
        if (p->kind == SB_PARAMETER_FORCE && body->node_component[node] < 0)
            return sbi_fail_node(error, SB_ERROR_INDEX, node, "parameter %d: node %d, of no element, feels no force", k,
                                 node);
        if (p->kind == SB_PARAMETER_SUPPORT && !(body->fixed[node] >> p->axis & 1))
            return sbi_fail_node(error, SB_ERROR_ARGUMENT, node, "parameter %d: node %d is not supported along axis %d",
                                 k, node, p->axis);
    }
    return SB_OK;
}

SBI_API sb_result sbi_parameter_check(const sb_body *body, const sb_parameter *p, int k, sb_error *error)
{
    int kind = (int)p->kind, has_axis = kind == SB_PARAMETER_GRAVITY || kind == SB_PARAMETER_FORCE ||
                                        kind == SB_PARAMETER_TARGET || kind == SB_PARAMETER_SUPPORT;
    if (kind < SB_PARAMETER_YOUNG || kind > SB_PARAMETER_SUPPORT)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "parameter %d: there is no kind %d", k, kind);
    if (p->node_count < 0)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "parameter %d: a count of %d nodes", k, p->node_count);
    if (has_axis && (p->axis < 0 || p->axis > 2))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "parameter %d: axis %d is not 0, 1 or 2", k, p->axis);
    if (sbi_parameter_is_of_material(p->kind) || kind == SB_PARAMETER_DENSITY)
        return sbi_parameter_check_region(body, p, k, error);
    if (kind == SB_PARAMETER_PRESSURE || kind == SB_PARAMETER_STIFFNESS || kind == SB_PARAMETER_TARGET)
        return sbi_parameter_check_load(body, p, k, error);
    return kind == SB_PARAMETER_GRAVITY ? SB_OK : sbi_parameter_check_nodes(body, p, k, error);
}

/* ---- dr/dp ---- */

static sb_vec3 sbi_axis(int axis) { return sb_v3((sb_real)(axis == 0), (sb_real)(axis == 1), (sb_real)(axis == 2)); }

/* What a node's mass is accelerated by, less gravity. */
static sb_vec3 sbi_parameter_acceleration(const sbi_equilibrium *eq, int node)
{
    const sb_body *b = eq->body;
    sb_vec3 weight = sb_v3_scale(-1, b->gravity);
    if (!eq->step.dynamic)
        return weight;
    return sb_v3_add(weight, sb_v3_madd(sbi_step_acceleration(&eq->step, node), sbi_step_alpha(b),
                                        sbi_step_velocity(&eq->step, node)));
}

/* Of a region: -int N g dV, and of a time step int N N (a + alpha v - g) dV by the body's kind of mass. */
static void sbi_parameter_weight(const sbi_equilibrium *eq, int region, sb_vec3 *residual)
{
    const sb_body *body = eq->body;
    const sb_domain *domain = &body->domain;
    const sb_mass_kind kind = eq->step.dynamic ? body->mass_kind : SB_MASS_LUMPED;
    int n = domain->nodes_per_cell, found;
    int index = sbi_body_find_region(body->material_regions, body->material_count, region, &found);
    for (int e = 0; e < domain->cell_count; e++) {
        const int *cell = domain->cells + (size_t)e * (size_t)n;
        sb_real mass[SB_MAX_ELEMENT_NODES * SB_MAX_ELEMENT_NODES], load[SB_MAX_ELEMENT_NODES];
        sb_vec3 x[SB_MAX_ELEMENT_NODES];
        if (body->cell_material[e] != index || sbi_domain_is_free(domain, e))
            continue;
        for (int a = 0; a < n; a++)
            x[a] = body->reference[cell[a]];
        sbi_body_cell_mass(body, e, kind, x, mass, load);
        for (int a = 0; a < n; a++)
            for (int b = 0; b < n; b++) {
                sb_real share = eq->step.dynamic ? mass[a * n + b] : a == b ? load[a] : 0;
                residual[cell[a]] = sb_v3_madd(residual[cell[a]], share, sbi_parameter_acceleration(eq, cell[b]));
            }
    }
}

/* -M e of an axis; of an equilibrium with the masses that weigh. */
static void sbi_parameter_gravity(const sbi_equilibrium *eq, int axis, sb_vec3 *residual)
{
    const sb_body *b = eq->body;
    for (int i = 0; i < eq->node_count; i++)
        eq->product[i] = sb_v3_scale(-1, sbi_axis(axis));
    if (eq->step.dynamic)
        sbi_body_mass_multiply(b, eq->product, residual);
    for (int i = 0; !eq->step.dynamic && i < eq->node_count; i++)
        residual[i] = sb_v3_scale(b->load_mass[i], eq->product[i]);
}

static void sbi_parameter_rows(const sb_body *body, const sb_parameter *p, sb_vec3 *residual)
{
    const sbi_load *load = sbi_loads_get(body, p->load_id);
    int first = p->row == SB_AUTO ? 0 : p->row, end = p->row == SB_AUTO ? load->row_count : p->row + 1;
    for (int j = first; j < end; j++) {
        sb_vec3 change = p->kind == SB_PARAMETER_TARGET
                             ? sb_v3_scale(-load->stiffness[j], sbi_axis(p->axis))
                             : sb_v3_sub(sbi_body_row_value(load, j, body->displacement), load->target[j]);
        sbi_load_spread_row(load, j, change, residual);
    }
}

static void sbi_parameter_elements(const sbi_equilibrium *eq, const sb_parameter *p, sb_vec3 *residual)
{
    sb_body *body = eq->body;
    int found, index = sbi_body_find_region(body->material_regions, body->material_count, p->region, &found);
    sb_real factor;
    sb_material change = sbi_parameter_material(p, body->materials + index, &factor);
    (void)sbi_assembly_add_share(&body->assembly, eq->strain, index, &change, residual);
    for (int i = 0; factor != 1 && i < body->domain.node_count; i++)
        residual[i] = sb_v3_scale(factor, residual[i]);
}

SBI_API void sbi_parameter_residual(const sbi_equilibrium *eq, const sb_parameter *p, sb_vec3 *residual)
{
    sb_body *b = eq->body;
    memset(residual, 0, (size_t)eq->node_count * sizeof *residual);
    if (sbi_parameter_is_of_material(p->kind))
        sbi_parameter_elements(eq, p, residual);
    if (p->kind == SB_PARAMETER_DENSITY)
        sbi_parameter_weight(eq, p->region, residual);
    if (p->kind == SB_PARAMETER_STIFFNESS || p->kind == SB_PARAMETER_TARGET)
        sbi_parameter_rows(b, p, residual);
    if (p->kind == SB_PARAMETER_PRESSURE)
        sbi_load_add_unit_pressure(b, sbi_loads_get(b, p->load_id), b->displacement, residual);
    if (p->kind == SB_PARAMETER_GRAVITY)
        sbi_parameter_gravity(eq, p->axis, residual);
    for (int i = 0; p->kind == SB_PARAMETER_FORCE && i < p->node_count; i++)
        residual[p->nodes[i]] = sb_v3_sub(residual[p->nodes[i]], sbi_axis(p->axis));
    for (int i = 0; p->kind == SB_PARAMETER_PRESSURE && i < eq->node_count; i++)
        residual[i] = sb_v3_scale(-1, residual[i]);
}

SBI_API void sbi_parameter_motion(const sb_parameter *p, int node_count, sb_vec3 *motion)
{
    memset(motion, 0, (size_t)node_count * sizeof *motion);
    for (int i = 0; p->kind == SB_PARAMETER_SUPPORT && i < p->node_count; i++)
        motion[p->nodes[i]] = sbi_axis(p->axis);
}
