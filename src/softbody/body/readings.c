/* readings: tensors and energies of a body by point, element and node. */
#include "readings.h"
#include "body_private.h"
#include "live_private.h"

#include <string.h>

/* ---- at a point ---- */

static sb_mat3 sbi_reading_strain(const sb_body *body, int element, const sb_mat3 *f)
{
    sb_mat3 unit = sb_m3_identity();
    if (body->materials[body->cell_material[element]].model == SB_LINEAR)
        return sb_m3_sub(sb_m3_scale((sb_real)0.5, sb_m3_add(*f, sb_m3_transpose(*f))), unit);
    return sb_m3_scale((sb_real)0.5, sb_m3_sub(sb_m3_tmul(*f, *f), unit));
}

SB_API sb_result sb_body_deformation(const sb_body *body, int element, int point, sb_mat3 *F)
{
    sb_mat3 f[SBI_CELL_POINTS], stress[SBI_CELL_POINTS];
    int admissible[SBI_CELL_POINTS];
    if (!body || !F)
        return SB_ERROR_ARGUMENT;
    if (!sb_body_cell_in_use(body, element) || point < 0 || point >= sbi_body_points(body))
        return SB_ERROR_INDEX;
    sbi_body_element_stresses(body, element, f, stress, admissible);
    *F = f[point];
    return SB_OK;
}

SB_API sb_result sb_body_strain(const sb_body *body, int element, int point, sb_mat3 *strain)
{
    sb_mat3 f;
    sb_result result = strain ? sb_body_deformation(body, element, point, &f) : SB_ERROR_ARGUMENT;
    if (result == SB_OK)
        *strain = sbi_reading_strain(body, element, &f);
    return result;
}

/* ---- at nodes ---- */

/* What takes values at integration points to the nodes of an element. */
typedef struct sbi_reading_rule {
    int fitted; /* 0: their mean goes to every node */
    sb_real shares[SB_MAX_ELEMENT_NODES][SB_MAX_QUADRATURE_POINTS];
} sbi_reading_rule;

/* Least squares by a + b . xi with the rule's weights: shares = phi(node)^T (sum w phi phi^T)^-1 w phi(point). */
static void sbi_reading_fit(sbi_element element, int count, sb_real (*points)[3], const sb_real *weights,
                            sbi_reading_rule *rule)
{
    sb_real normal[16];
    memset(normal, 0, sizeof normal);
    for (int p = 0; p < count; p++) {
        const sb_real phi[4] = {1, points[p][0], points[p][1], points[p][2]};
        for (int i = 0; i < 16; i++)
            normal[i] += weights[p] * phi[i / 4] * phi[i % 4];
    }
    rule->fitted = count >= 4 && sb_cholesky_factor(normal, 4) == 0;
    for (int a = 0; rule->fitted && a < sbi_element_node_count(element); a++) {
        sb_real xi[3], row[4];
        sbi_element_node_point(element, a, xi);
        row[0] = 1, row[1] = xi[0], row[2] = xi[1], row[3] = xi[2];
        sb_cholesky_solve(normal, 4, row);
        for (int p = 0; p < count; p++)
            rule->shares[a][p] =
                weights[p] * (row[0] + row[1] * points[p][0] + row[2] * points[p][1] + row[3] * points[p][2]);
    }
}

static void sbi_reading_make_rule(const sb_body *body, sbi_reading_rule *rule)
{
    sbi_element element = sbi_domain_element(&body->domain);
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    int count = sbi_body_points(body);
    rule->fitted = 0;
    if (body->own_points) /* nobody knows where they are */
        return;
    if (sbi_element_quadrature(element, SB_QUADRATURE_STIFFNESS, points, weights) != count &&
        sbi_element_quadrature(element, SB_QUADRATURE_STIFFNESS_CURVED, points, weights) != count)
        return;
    sbi_reading_fit(element, count, points, weights, rule);
}

/* The tensor at an element's points; 0 where one that counts has none. */
static int sbi_reading_points(const sb_body *body, int element, int tensor, sb_mat3 *values)
{
    const sb_real *weights = body->domain.weights + (size_t)element * (size_t)body->domain.points_per_cell;
    sb_mat3 f[SBI_CELL_POINTS];
    int admissible[SBI_CELL_POINTS], good = 1;
    sbi_body_element_stresses(body, element, f, values, admissible);
    for (int p = 0; p < sbi_body_points(body); p++) {
        if (tensor == SB_TENSOR_STRAIN)
            values[p] = sbi_reading_strain(body, element, f + p);
        else if (!admissible[p] && weights[p] > 0)
            good = 0;
    }
    return good;
}

/* The tensor at local node a of an element with values at its points, whose weights sum to volume. */
static sb_mat3 sbi_reading_at_node(const sb_body *body, int element, const sbi_reading_rule *rule, int a,
                                   const sb_mat3 *values, sb_real volume)
{
    const sb_real *weights = body->domain.weights + (size_t)element * (size_t)body->domain.points_per_cell;
    int fitted = rule->fitted && !sbi_live_is_piece(body, element);
    sb_mat3 sum = sb_m3_zero();
    for (int p = 0; p < sbi_body_points(body); p++)
        sum = sb_m3_add(sum, sb_m3_scale(fitted ? rule->shares[a][p] : weights[p] / volume, values[p]));
    return sum;
}

/* Adds what an element has to its nodes, times its volume. */
static void sbi_reading_spread(const sb_body *body, int element, const sbi_reading_rule *rule, int tensor,
                               sb_mat3 *values)
{
    const sb_domain *domain = &body->domain;
    const int *nodes = domain->cells + (size_t)element * (size_t)domain->nodes_per_cell;
    sb_real volume = sbi_body_element_volume(body, element);
    sb_mat3 points[SBI_CELL_POINTS];
    if (!(volume > 0))
        return;
    (void)sbi_reading_points(body, element, tensor, points);
    for (int a = 0; a < domain->nodes_per_cell; a++)
        values[nodes[a]] = sb_m3_add(values[nodes[a]],
                                     sb_m3_scale(volume, sbi_reading_at_node(body, element, rule, a, points, volume)));
}

/* 1 when readings of this material (an index, -1: all) include the cell. */
static int sbi_reading_has_cell(const sb_body *body, int cell, int material)
{
    return sbi_live_has_cell(body, cell) && (material < 0 || body->cell_material[cell] == material);
}

/* Volume of the cells of a material around a node. */
static sb_real sbi_reading_volume(const sb_body *body, int node, int material)
{
    sb_real sum = 0;
    for (int at = sbi_live_first_cell(body, node); at >= 0; at = sbi_live_next_cell(body, node, at))
        if (sbi_reading_has_cell(body, sbi_live_cell_of(body, at), material))
            sum += sbi_body_element_volume(body, sbi_live_cell_of(body, at));
    return sum;
}

static sb_result sbi_reading_nodes(const sb_body *body, int material, int tensor, sb_mat3 *values, sb_error *error)
{
    sbi_reading_rule rule;
    sb_mat3 points[SBI_CELL_POINTS];
    if (tensor != SB_TENSOR_STRESS && tensor != SB_TENSOR_STRAIN)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the tensor %d is unknown", tensor);
    for (int e = 0; tensor == SB_TENSOR_STRESS && e < body->domain.cell_count; e++)
        if (sbi_reading_has_cell(body, e, material) && !sbi_reading_points(body, e, tensor, points))
            return sbi_fail_element(error, SB_ERROR_INVERTED, e,
                                    "element %d has no stress: it is inside out, or its "
                                    "stress is too large",
                                    e);
    sbi_reading_make_rule(body, &rule);
    for (int i = 0; i < body->domain.node_count; i++)
        values[i] = sb_m3_zero();
    for (int e = 0; e < body->domain.cell_count; e++)
        if (sbi_reading_has_cell(body, e, material))
            sbi_reading_spread(body, e, &rule, tensor, values);
    for (int i = 0; i < body->domain.node_count; i++) {
        sb_real volume = sbi_reading_volume(body, i, material);
        values[i] = volume > 0 ? sb_m3_scale(1 / volume, values[i]) : sb_m3_zero();
    }
    return SB_OK;
}

SB_API sb_result sb_body_nodal_tensors(const sb_body *body, int tensor, sb_mat3 *values, sb_error *error)
{
    if (!body || !values)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "tensors at nodes need a body and room");
    return sbi_reading_nodes(body, -1, tensor, values, error);
}

SB_API sb_result sb_body_region_tensors(const sb_body *body, int region, int tensor, sb_mat3 *values, sb_error *error)
{
    if (!body || !values)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "tensors at nodes need a body and room");
    for (int i = 0; i < body->material_count; i++)
        if (body->material_regions[i] == region)
            return sbi_reading_nodes(body, i, tensor, values, error);
    return sbi_fail(error, SB_ERROR_INDEX, "the mesh has no region %d", region);
}

/* ---- energy ---- */

/* Densities of all elements; the element that has none, or -1. values may be NULL. */
static int sbi_reading_energies(const sb_body *body, sb_real *values, int *finite)
{
    for (int e = 0; e < body->domain.cell_count; e++) {
        sb_real energy = 0, volume = sbi_body_element_volume(body, e);
        if (volume > 0 && !sbi_assembly_cell_energy(&body->assembly, body->displacement, e, &energy))
            return e;
        *finite &= sb_is_finite(energy) && (!(volume > 0) || sb_is_finite(energy / volume));
        if (values)
            values[e] = volume > 0 ? energy / volume : 0;
    }
    return -1;
}

SB_API sb_result sb_body_energy_densities(sb_body *body, sb_real *values, sb_error *error)
{
    int bad, finite = 1;
    if (!body || !values)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "energy densities need a body and room");
    sbi_assembly_begin_step(&body->assembly, (sb_real)INFINITY);
    bad = sbi_reading_energies(body, NULL, &finite);
    if (bad < 0 && finite)
        (void)sbi_reading_energies(body, values, &finite);
    sbi_assembly_begin_step(&body->assembly, 0);
    if (bad >= 0)
        return sbi_fail_element(error, SB_ERROR_INVERTED, bad,
                                "element %d is inside out, which its material does not allow", bad);
    if (!finite)
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "an energy is beyond what sb_real holds");
    return SB_OK;
}
