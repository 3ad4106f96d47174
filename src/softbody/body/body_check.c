/* body_check: what is unusual about a body. */
#include "body.h"
#include "body_private.h"
#include "rigid_private.h"
#include "live_private.h"

#include <string.h>

/* 1 when an element before this one has the same corners. */
static int sbi_body_is_duplicate(const sb_body *body, int element)
{
    int n = body->domain.nodes_per_cell, corners = sbi_element_corner_count(sbi_domain_element(&body->domain));
    const int *cell = body->domain.cells + (size_t)element * (size_t)n;
    int local[SB_MAX_ELEMENT_NODES];
    for (int a = 0; a < corners; a++)
        local[a] = a;
    for (int at = sbi_live_first_cell(body, cell[0]); at >= 0; at = sbi_live_next_cell(body, cell[0], at)) {
        int e = sbi_live_cell_of(body, at);
        if (e >= element)
            return 0;
        if (sbi_body_has_corners(cell, body->domain.cells + (size_t)e * (size_t)n, local, corners))
            return 1;
    }
    return 0;
}

static void sbi_body_check_mesh(const sb_body *body, sb_check_report *report)
{
    sb_mesh mesh = sbi_body_mesh_view(body);
    report->size = sbi_body_size(body);
    report->worst_quality = 1;
    for (int e = 0; e < mesh.element_count; e++) {
        if (!sbi_live_has_cell(body, e))
            continue;
        sb_real quality = sb_mesh_element_quality(&mesh, e);
        report->sliver_count += quality < (sb_real)0.1;
        report->duplicate_count += !body->own_points && !sbi_live_is_piece(body, e) && sbi_body_is_duplicate(body, e);
        if (report->worst_element < 0 || quality < report->worst_quality) {
            report->worst_quality = quality;
            report->worst_element = e;
        }
    }
    for (int i = 0; i < mesh.node_count; i++)
        report->unreferenced_count += body->node_component[i] < 0 && sb_body_node_in_use(body, i);
    report->component_count = body->component_count;
    if (report->size > 10 || report->size < (sb_real)1e-3)
        report->warnings |= SB_CHECK_SIZE;
    if (report->sliver_count > 0)
        report->warnings |= SB_CHECK_SLIVERS;
    if (report->unreferenced_count > 0)
        report->warnings |= SB_CHECK_UNREFERENCED;
    if (report->duplicate_count > 0)
        report->warnings |= SB_CHECK_DUPLICATES;
    if (report->component_count > 1)
        report->warnings |= SB_CHECK_COMPONENTS;
}

/* Poisson's ratio from which the body's elements lose more than 2 % to locking; measured, see sb_check_report. */
static sb_real sbi_body_locking_limit(const sb_domain *domain)
{
    sbi_element element = sbi_domain_element(domain);
    if (domain->mean_points || domain->cell_patch)
        return (sb_real)0.5;
    switch (domain->element_type) {
    case SB_TET4: return (sb_real)0.35;
    case SB_TET10: return (sb_real)0.495;
    case SB_HEX8: return (sb_real)0.4;
    case SB_CUSTOM:
        return sbi_element_node_count(element) == sbi_element_corner_count(element) ? (sb_real)0.4 : (sb_real)0.49;
    default: return (sb_real)0.49;
    }
}

static void sbi_body_check_locking(const sb_body *body, sb_check_report *report)
{
    const sb_real rounding = 1 + (sb_real)1e-5; /* of a ratio that was made of moduli */
    report->locking_limit = sbi_body_locking_limit(&body->domain);
    report->locking_element = -1;
    for (int e = 0; e < body->domain.cell_count; e++) {
        if (!sbi_live_has_cell(body, e) ||
            !(sb_material_poisson(body->materials + body->cell_material[e]) > rounding * report->locking_limit))
            continue;
        if (report->locking_count++ == 0)
            report->locking_element = e;
    }
    if (report->locking_count > 0)
        report->warnings |= SB_CHECK_LOCKING;
}

static void sbi_body_check_materials(const sb_body *body, sb_check_report *report)
{
    for (int i = 0; i < body->material_count; i++) {
        const sb_material *material = body->materials + i;
        sb_real young = sb_material_young(material);
        if (material->density < 100 || material->density > 10000)
            report->warnings |= SB_CHECK_DENSITY;
        if (young < 10 || young > (sb_real)1e7)
            report->warnings |= SB_CHECK_STIFFNESS;
    }
    sbi_body_check_locking(body, report);
}

SB_API sb_result sb_body_check(const sb_body *body, sb_check_report *report)
{
    sbi_loose loose;
    if (!body || !report)
        return SB_ERROR_ARGUMENT;
    memset(report, 0, sizeof *report);
    report->worst_element = -1;
    sbi_body_check_mesh(body, report);
    sbi_body_check_materials(body, report);
    if (sbi_body_find_loose(body, &loose, NULL) != SB_OK)
        return SB_ERROR_MEMORY;
    report->unsupported_component_node = loose.node;
    if (loose.node >= 0 || loose.rigid > 0)
        report->warnings |= SB_CHECK_UNSUPPORTED;
    return SB_OK;
}

SB_API const char *sb_check_string(unsigned warning)
{
    switch (warning) {
    case SB_CHECK_SIZE: return "the mesh is larger than 10 m or smaller than 1 mm: is it in metres?";
    case SB_CHECK_DENSITY: return "a density is outside 100 to 10,000 kg/m^3: are the units SI?";
    case SB_CHECK_STIFFNESS: return "a Young's modulus is outside 10 Pa to 10 MPa: are the units SI?";
    case SB_CHECK_SLIVERS: return "some elements are slivers (quality under 0.1): solves will be slow";
    case SB_CHECK_LOCKING:
        return "Poisson's ratio is too high for this element, which locks and is too stiff: use B-bar hex8";
    case SB_CHECK_UNREFERENCED: return "some nodes belong to no element and are held in place";
    case SB_CHECK_UNSUPPORTED: return "a part is not fully supported: static solves will refuse it";
    case SB_CHECK_DUPLICATES: return "some elements are there twice: their mass and stiffness count twice";
    case SB_CHECK_COMPONENTS: return "the mesh has more than one connected part";
    default: return "unknown warning";
    }
}
