/* body_material: regions, their materials, fibres, and what follows from them. */
#include "../fem/material_law.h"
#include "body.h"
#include "body_private.h"
#include "live_private.h"

#include <string.h>

/* ---- regions ---- */

static int sbi_body_region(const sb_mesh *mesh, int element) { return mesh->regions ? mesh->regions[element] : 0; }

SBI_API int sbi_body_find_region(const int *regions, int count, int region, int *found)
{
    int low = 0, high = count;
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (regions[middle] < region)
            low = middle + 1;
        else
            high = middle;
    }
    *found = low < count && regions[low] == region;
    return low;
}

/* Lists the distinct regions of a mesh, ascending, in regions[capacity]; returns how many there are (counting on
 * past the capacity when it is too small, so that the caller can come back with more). */
static int sbi_body_list_regions(const sb_mesh *mesh, int *regions, int capacity)
{
    int count = 0, last = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        int region = sbi_body_region(mesh, e), found, at;
        if (e > 0 && region == last)
            continue;
        last = region;
        at = sbi_body_find_region(regions, sbi_min_int(count, capacity), region, &found);
        if (found)
            continue;
        if (count < capacity) {
            memmove(regions + at + 1, regions + at, (size_t)(count - at) * sizeof *regions);
            regions[at] = region;
        }
        count++;
    }
    return count;
}

/* Keeps the law of a material for states and recordings. */
static sb_result sbi_body_know_law(sb_body *body, const sb_material *material, sb_error *error)
{
    const sb_material_law *law = material->law, **laws;
    if (!law)
        return SB_OK;
    if (!law->name || !law->name[0])
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a material law needs a name");
    for (int i = 0; i < body->law_count; i++) {
        if (body->laws[i] == law)
            return SB_OK;
        if (sbi_law_mark(body->laws[i]) == sbi_law_mark(law))
            return sbi_fail(error, SB_ERROR_ARGUMENT,
                            "the body has another material law of the name %s: states could not tell them apart",
                            law->name);
    }
    laws = (const sb_material_law **)sbi_alloc(&body->allocator, (size_t)body->law_count + 1, sizeof *laws);
    if (!laws)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d material laws", body->law_count + 1);
    for (int i = 0; i < body->law_count; i++)
        laws[i] = body->laws[i];
    sbi_free(&body->allocator, (void *)body->laws);
    body->laws = laws;
    body->laws[body->law_count++] = law;
    return SB_OK;
}

SBI_API sb_result sbi_body_make_materials(sb_body *body, const sb_body_def *def, sb_error *error)
{
    int capacity = 4, count, found;
    for (;; capacity = count) {
        sbi_free(&body->allocator, body->material_regions);
        body->material_regions = (int *)sbi_alloc(&body->allocator, (size_t)capacity, sizeof(int));
        if (!body->material_regions)
            return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d regions", capacity);
        count = sbi_body_list_regions(def->mesh, body->material_regions, capacity);
        if (count <= capacity)
            break;
    }
    body->material_count = count;
    body->materials = (sb_material *)sbi_alloc(&body->allocator, (size_t)count, sizeof(sb_material));
    body->twins = (sb_material *)sbi_alloc(&body->allocator, (size_t)count, sizeof(sb_material));
    body->made_young = (sb_real *)sbi_alloc(&body->allocator, (size_t)count, sizeof(sb_real));
    body->cell_material = (int *)sbi_alloc(&body->allocator, (size_t)def->mesh->element_count, sizeof(int));
    if (!body->materials || !body->twins || !body->made_young || !body->cell_material || !sbi_body_take_regions(body))
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for %d materials", count);
    for (int e = 0; e < def->mesh->element_count; e++)
        body->cell_material[e] =
            sbi_body_find_region(body->material_regions, count, sbi_body_region(def->mesh, e), &found);
    for (int k = 0; k < def->region_material_count; k++) {
        for (int i = 0; i < k; i++)
            if (def->region_materials[i].region == def->region_materials[k].region)
                return sbi_fail(error, SB_ERROR_ARGUMENT, "def.region_materials names region %d twice",
                                def->region_materials[k].region);
        sbi_body_find_region(body->material_regions, count, def->region_materials[k].region, &found);
        if (!found)
            return sbi_fail(error, SB_ERROR_INDEX, "def.region_materials names region %d, which the mesh does not have",
                            def->region_materials[k].region);
    }
    for (int i = 0; i < count; i++) {
        const sb_material *material = &def->material;
        for (int k = 0; k < def->region_material_count; k++)
            if (def->region_materials[k].region == body->material_regions[i])
                material = &def->region_materials[k].material;
        sb_result result = sbi_body_check_material(material, body->domain.single_rotation, error);
        if (result == SB_OK)
            result = sbi_body_know_law(body, material, error);
        if (result != SB_OK)
            return result;
        body->materials[i] = *material;
        body->made_young[i] = sb_material_young(material);
    }
    return SB_OK;
}

/* ---- fibres ---- */

/* SB_ERROR_MATERIAL naming the first element of material `index` (-1: of any), if that is to have fibres. */
static sb_result sbi_body_miss_fibres(const sb_body *body, int index, const sb_material *material, sb_error *error)
{
    for (int e = 0; e < body->domain.cell_count && sbi_material_has_fibres(material); e++)
        if ((index < 0 || body->cell_material[e] == index) && sbi_live_has_cell(body, e))
            return sbi_fail_element(error, SB_ERROR_MATERIAL, e,
                                    "the material of element %d has fibres, but no directions were given (def.fibres)",
                                    e);
    return SB_OK;
}

/* Copies the directions at unit length. Scaled first, so that neither long nor short ones lose their square. */
SBI_API void sbi_body_copy_fibres(sb_vec3 *out, const sb_vec3 *fibres, int count)
{
    for (int e = 0; e < count; e++) {
        sb_vec3 a = fibres[e];
        sb_real largest = sb_max(sb_max(sb_abs(a.x), sb_abs(a.y)), sb_abs(a.z));
        if (largest > 0) {
            a = sb_v3(a.x / largest, a.y / largest, a.z / largest);
            a = sb_v3_scale(1 / sb_v3_norm(a), a);
        }
        out[e] = a;
    }
}

/* Names the first direction that is not finite. */
static sb_result sbi_body_check_fibres(const sb_body *body, const sb_vec3 *fibres, sb_error *error)
{
    for (int e = 0; fibres && e < body->domain.cell_count; e++)
        if (!sb_v3_is_finite(fibres[e]))
            return sbi_fail_element(error, SB_ERROR_NOT_FINITE, e, "the fibre direction of element %d is not finite",
                                    e);
    return SB_OK;
}

/* A family (1: the first, 2: the second) has these directions from now on. */
static void sbi_body_fibres_changed(sb_body *body, int family, const sb_vec3 *fibres)
{
    body->assembly.fibres = body->fibres;
    body->assembly.second_fibres = body->second_fibres;
    body->force_current = 0;
    body->acceleration_known = 0;
    sbi_body_tell(body, SBI_COMMAND_FIBRES, fibres != NULL, family, NULL, 0, fibres ? &fibres[0].x : NULL,
                  fibres ? 3 * (size_t)body->domain.cell_count : 0);
}

SB_API sb_result sb_body_set_fibres(sb_body *body, const sb_vec3 *fibres, sb_error *error)
{
    int count;
    sb_vec3 *copy;
    sb_result result;
    if (!body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_set_fibres needs a body");
    count = body->domain.cell_count;
    result = sbi_body_check_fibres(body, fibres, error);
    if (result != SB_OK)
        return result;
    copy = body->fibres;
    if (!fibres) {
        for (int i = 0; i < body->material_count; i++) {
            result = sbi_body_miss_fibres(body, i, body->materials + i, error);
            if (result != SB_OK)
                return result;
        }
        sbi_free(&body->allocator, copy);
        sbi_free(&body->allocator, body->second_fibres);
        copy = body->second_fibres = NULL;
    } else if (!copy) {
        copy = (sb_vec3 *)sbi_alloc_zeroed(&body->allocator, (size_t)sbi_live_cell_room(body), sizeof *copy);
        if (!copy)
            return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the fibres of %d elements", count);
    }
    if (fibres)
        sbi_body_copy_fibres(copy, fibres, count);
    body->fibres = copy;
    sbi_body_fibres_changed(body, 1, fibres);
    return SB_OK;
}

SB_API sb_result sb_body_set_second_fibres(sb_body *body, const sb_vec3 *fibres, sb_error *error)
{
    sb_result result;
    if (!body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_set_second_fibres needs a body");
    if (fibres && body->live)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "a mesh that may change (def.slack) has one family of fibres");
    if (fibres && !body->fibres)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "a second family of fibres needs a first one: sb_body_set_fibres");
    result = sbi_body_check_fibres(body, fibres, error);
    if (result != SB_OK)
        return result;
    if (!fibres) {
        sbi_free(&body->allocator, body->second_fibres);
        body->second_fibres = NULL;
    } else if (!body->second_fibres) {
        body->second_fibres = (sb_vec3 *)sbi_alloc(&body->allocator, (size_t)body->domain.cell_count, sizeof(sb_vec3));
        if (!body->second_fibres)
            return sbi_fail(error, SB_ERROR_MEMORY, "no memory for the fibres of %d elements", body->domain.cell_count);
    }
    if (fibres)
        sbi_body_copy_fibres(body->second_fibres, fibres, body->domain.cell_count);
    sbi_body_fibres_changed(body, 2, fibres);
    return SB_OK;
}

SBI_API sb_result sbi_body_prepare_material(sb_body *body, int index, const sb_material *material, sb_error *error)
{
    sb_result result = body->fibres ? SB_OK : sbi_body_miss_fibres(body, index, material, error);
    if (result == SB_OK)
        result = sbi_assembly_reserve_memory(&body->assembly, material->prony_count, &body->allocator, error);
    return result;
}

/* ---- materials ---- */

SBI_API sb_result sbi_body_check_material(const sb_material *material, int single_rotation, sb_error *error)
{
    sb_result result = sb_material_check(material, error);
    if (result == SB_OK && single_rotation && material->model != SB_COROTATED)
        return sbi_fail(error, SB_ERROR_MATERIAL, "one rotation per element needs the corotated material");
    return result;
}

SBI_API void sbi_body_pack_material(const sb_material *material, sb_real *reals)
{
    const sb_real moduli[SBI_MATERIAL_MODULI] = {material->density,
                                                 material->lambda,
                                                 material->mu,
                                                 material->c10,
                                                 material->d1,
                                                 material->c01,
                                                 material->c20,
                                                 material->c30,
                                                 material->fibre_stiffness,
                                                 material->fibre_exponent,
                                                 material->fung_exponent,
                                                 material->fibre_dispersion,
                                                 material->fibre_tension,
                                                 material->fibre_optimum,
                                                 material->fibre_width,
                                                 material->law_scale,
                                                 material->model == SB_CUSTOM_LAW ? sbi_law_mark(material->law) : 0};
    memcpy(reals, moduli, sizeof moduli);
    memcpy(reals + SBI_MATERIAL_OGDEN, material->ogden_mu, sizeof material->ogden_mu);
    memcpy(reals + SBI_MATERIAL_OGDEN + SB_MAX_OGDEN_TERMS, material->ogden_alpha, sizeof material->ogden_alpha);
    memcpy(reals + SBI_MATERIAL_PRONY, material->prony_g, sizeof material->prony_g);
    memcpy(reals + SBI_MATERIAL_PRONY + SB_MAX_PRONY_TERMS, material->prony_tau, sizeof material->prony_tau);
}

static const sb_material_law *sbi_body_find_law(const sb_body *body, sb_real mark)
{
    for (int i = 0; i < body->law_count && mark > 0; i++)
        if (sbi_law_mark(body->laws[i]) == mark)
            return body->laws[i];
    return NULL;
}

SBI_API sb_material sbi_body_unpack_material(const sb_body *body, int model, int prony_count, const sb_real *reals)
{
    sb_material m;
    memset(&m, 0, sizeof m);
    m.model = (sb_material_model)model;
    m.prony_count = prony_count;
    m.density = reals[0];
    m.lambda = reals[1];
    m.mu = reals[2];
    m.c10 = reals[3];
    m.d1 = reals[4];
    m.c01 = reals[5];
    m.c20 = reals[6];
    m.c30 = reals[7];
    m.fibre_stiffness = reals[8];
    m.fibre_exponent = reals[9];
    m.fung_exponent = reals[10];
    m.fibre_dispersion = reals[11];
    m.fibre_tension = reals[12];
    m.fibre_optimum = reals[13];
    m.fibre_width = reals[14];
    m.law_scale = reals[15];
    m.law = sbi_body_find_law(body, reals[16]);
    memcpy(m.ogden_mu, reals + SBI_MATERIAL_OGDEN, sizeof m.ogden_mu);
    memcpy(m.ogden_alpha, reals + SBI_MATERIAL_OGDEN + SB_MAX_OGDEN_TERMS, sizeof m.ogden_alpha);
    memcpy(m.prony_g, reals + SBI_MATERIAL_PRONY, sizeof m.prony_g);
    memcpy(m.prony_tau, reals + SBI_MATERIAL_PRONY + SB_MAX_PRONY_TERMS, sizeof m.prony_tau);
    return m;
}

static void sbi_body_tell_material(sb_body *body, int all, int region, const sb_material *material)
{
    const int ints[3] = {region, (int)material->model, material->prony_count};
    sb_real reals[(int)SBI_MATERIAL_REALS + (int)SBI_MATERIAL_PRESTRETCH];
    size_t more = sbi_material_is_prestretched(material) ? SBI_MATERIAL_PRESTRETCH : 0;
    sbi_body_pack_material(material, reals);
    memcpy(reals + SBI_MATERIAL_REALS, material->prestretch.m, sizeof material->prestretch.m);
    sbi_body_tell(body, SBI_COMMAND_MATERIAL, all, 0, ints, 3, reals, SBI_MATERIAL_REALS + more);
}

SBI_API void sbi_body_materials_changed(sb_body *body)
{
    sbi_assembly_set_materials(&body->assembly, body->materials, body->material_count, body->cell_material);
    sbi_kept_forget(body);
    if (body->live) {
        sbi_live_stiffen_slivers(body);
        sbi_live_stiffen_glue(body);
    }
    body->force_unit = body->assembly.energy_unit / sbi_body_size(body);
    sbi_body_update_mass(body);
    body->force_current = 0;
    body->acceleration_known = 0;
}

SBI_API void sbi_body_read_cell_stiffness(sb_body *body)
{
    sbi_assembly_set_materials(&body->assembly, body->materials, body->material_count, body->cell_material);
    body->force_unit = body->assembly.energy_unit / sbi_body_size(body);
}

SBI_API void sbi_body_cells_stiffened(sb_body *body)
{
    sbi_body_read_cell_stiffness(body);
    sbi_kept_forget(body);
    body->force_current = 0;
    body->acceleration_known = 0;
    body->guard.stable_step = 0;
    body->guard.monitor_open = 0; /* what strained tissue gains by being stiffer comes from outside */
}

SB_API sb_result sb_body_set_material(sb_body *body, const sb_material *material, sb_error *error)
{
    sb_result result;
    if (!body || !material)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_set_material needs a body and a material");
    result = sbi_body_check_material(material, body->domain.single_rotation, error);
    if (result == SB_OK)
        result = sbi_body_prepare_material(body, -1, material, error);
    if (result == SB_OK)
        result = sbi_body_reserve_damping(body, material, 1, error);
    if (result == SB_OK)
        result = sbi_body_know_law(body, material, error);
    if (result != SB_OK)
        return result;
    for (int i = 0; i < body->material_count; i++)
        body->materials[i] = *material;
    sbi_body_materials_changed(body);
    sbi_assembly_forget(&body->assembly, -1, body->displacement);
    sbi_body_tell_material(body, 1, 0, material);
    return SB_OK;
}

SB_API sb_result sb_body_set_region_material(sb_body *body, int region, const sb_material *material, sb_error *error)
{
    sb_result result;
    int at, found;
    if (!body || !material)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_set_region_material needs a body and a material");
    at = sbi_body_find_region(body->material_regions, body->material_count, region, &found);
    if (!found)
        return sbi_fail(error, SB_ERROR_INDEX, "the mesh has no region %d", region);
    result = sbi_body_check_material(material, body->domain.single_rotation, error);
    if (result == SB_OK)
        result = sbi_body_prepare_material(body, at, material, error);
    if (result == SB_OK)
        result = sbi_body_reserve_damping(body, material, 1, error);
    if (result == SB_OK)
        result = sbi_body_know_law(body, material, error);
    if (result != SB_OK)
        return result;
    body->materials[at] = *material;
    sbi_body_materials_changed(body);
    sbi_assembly_forget(&body->assembly, at, body->displacement);
    sbi_body_tell_material(body, 0, region, material);
    return SB_OK;
}

SB_API sb_result sb_body_set_tension(sb_body *body, int region, sb_real tension, sb_error *error)
{
    sb_material material;
    sb_result result;
    int at, found;
    if (!body)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_body_set_tension needs a body");
    at = sbi_body_find_region(body->material_regions, body->material_count, region, &found);
    if (!found)
        return sbi_fail(error, SB_ERROR_INDEX, "the mesh has no region %d", region);
    material = body->materials[at];
    material.fibre_tension = tension;
    result = sbi_body_check_material(&material, body->domain.single_rotation, error);
    if (result == SB_OK && !body->fibres)
        result = sbi_body_miss_fibres(body, at, &material, error);
    if (result != SB_OK)
        return result;
    body->materials[at] = material;
    sbi_body_materials_changed(body);
    body->guard.monitor_open = 0; /* what a muscle gives or takes is no loss */
    sbi_body_tell_material(body, SBI_MATERIAL_TENSION, region, &material);
    return SB_OK;
}
