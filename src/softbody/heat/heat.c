/* heat: making, held nodes and readings. */
#include "heat.h"

#include <string.h>

#include "heat_private.h"

#define SBI_HEAT_COOKIE 0x4ea70u

SB_API sb_heat_tissue sb_default_heat_tissue(void)
{
    sb_heat_tissue tissue;
    memset(&tissue, 0, sizeof tissue);
    tissue.conductivity = (sb_real)0.5;
    tissue.capacity = (sb_real)3.8e6;
    tissue.perfusion = 24041;
    return tissue;
}

SB_API sb_heat_def sb_default_heat_def(void)
{
    sb_heat_def def;
    memset(&def, 0, sizeof def);
    def.tissue = sb_default_heat_tissue();
    def.start = def.blood = (sb_real)310.15;
    def.latent_low = (sb_real)372.15;
    def.latent_high = (sb_real)374.15;
    def.log_frequency = (sb_real)91.80094641; /* ln 7.39e39 */
    def.activation = (sb_real)2.577e5;
    def.harmless = (sb_real)316.15;
    def.tolerance = SB_REAL_IS_FLOAT ? (sb_real)1e-5 : (sb_real)1e-8;
    def.max_iterations = 1000;
    def.cookie = SBI_HEAT_COOKIE;
    return def;
}

/* ---- checks ---- */

/* A field that must be finite and above (or, with zero, at) 0. */
static sb_result sbi_heat_check_number(sb_real value, int zero, const char *what, int region, sb_error *error)
{
    if (!sb_is_finite(value))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "%s of %s %d is not finite", what,
                        region < 0 ? "the tissue of regions not named, region" : "region", region);
    if (value < 0 || (value == 0 && !zero))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "%s of %s %d is %g, which must be %s 0", what,
                        region < 0 ? "the tissue of regions not named, region" : "region", region, (double)value,
                        zero ? "at least" : "above");
    return SB_OK;
}

static sb_result sbi_heat_check_tissue(const sb_heat_tissue *tissue, int region, sb_error *error)
{
    sb_result result = sbi_heat_check_number(tissue->conductivity, 0, "the conductivity", region, error);
    if (result == SB_OK)
        result = sbi_heat_check_number(tissue->capacity, 0, "the heat capacity", region, error);
    if (result == SB_OK)
        result = sbi_heat_check_number(tissue->perfusion, 1, "the perfusion", region, error);
    if (result == SB_OK)
        result = sbi_heat_check_number(tissue->metabolic, 1, "the metabolic heat", region, error);
    if (result == SB_OK)
        result = sbi_heat_check_number(tissue->latent_heat, 1, "the latent heat", region, error);
    return result;
}

static sb_result sbi_heat_check_regions(const sb_body *body, const sb_heat_def *def, sb_error *error)
{
    sb_result result = sbi_heat_check_tissue(&def->tissue, -1, error);
    if (result == SB_OK && (def->region_count < 0 || (def->region_count > 0 && !def->regions)))
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "def.regions is NULL, or def.region_count below 0");
    for (int k = 0; k < def->region_count && result == SB_OK; k++) {
        int found;
        sbi_body_find_region(body->material_regions, body->material_count, def->regions[k].region, &found);
        if (!found)
            return sbi_fail(error, SB_ERROR_INDEX, "def.regions names region %d, which the mesh does not have",
                            def->regions[k].region);
        for (int i = 0; i < k; i++)
            if (def->regions[i].region == def->regions[k].region)
                return sbi_fail(error, SB_ERROR_ARGUMENT, "def.regions names region %d twice", def->regions[k].region);
        result = sbi_heat_check_tissue(&def->regions[k].tissue, def->regions[k].region, error);
    }
    return result;
}

static sb_result sbi_heat_check_elements(const sb_body *body, const sb_real *values, const char *what, sb_error *error)
{
    for (int e = 0; values && e < body->domain.cell_count; e++)
        if (!sb_is_finite(values[e]) || values[e] < 0)
            return sbi_fail_element(error, sb_is_finite(values[e]) ? SB_ERROR_ARGUMENT : SB_ERROR_NOT_FINITE, e,
                                    "the %s of element %d is %g", what, e, (double)values[e]);
    return SB_OK;
}

static sb_result sbi_heat_check_law(const sb_heat_def *def, sb_error *error)
{
    if (!sb_is_finite(def->start) || !sb_is_finite(def->blood) || !sb_is_finite(def->latent_low) ||
        !sb_is_finite(def->latent_high) || !sb_is_finite(def->log_frequency) || !sb_is_finite(def->activation) ||
        !sb_is_finite(def->stiffening) || !sb_is_finite(def->harmless))
        return sbi_fail(error, SB_ERROR_NOT_FINITE,
                        "def.start, blood, latent_low, latent_high, log_frequency, activation, harmless or stiffening "
                        "is not finite");
    if (!(def->start > 0) || !(def->blood > 0) || !(def->harmless > 0))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.start, def.blood and def.harmless must be above 0 K");
    if (!(def->latent_low > 0) || !(def->latent_high > def->latent_low))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.latent_low must be above 0 K and below def.latent_high");
    if (!(def->activation > 0) || !(def->stiffening > -1))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.activation must be above 0, def.stiffening above -1");
    if (!(def->tolerance > 0 && def->tolerance < 1) || def->max_iterations < 1)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.tolerance must be in (0, 1), def.max_iterations at least 1");
    return SB_OK;
}

static sb_result sbi_heat_check_def(const sb_body *body, const sb_heat_def *def, sb_error *error)
{
    sb_result result;
    if (def->cookie != SBI_HEAT_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "start from sb_default_heat_def()");
    if (body->live)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "heat is not of bodies whose mesh may change (def.slack)");
    if (sbi_domain_is_cloud(&body->domain))
        return sbi_fail(error, SB_ERROR_UNSUPPORTED, "heat is not of clouds");
    result = sbi_heat_check_law(def, error);
    if (result == SB_OK)
        result = sbi_heat_check_regions(body, def, error);
    if (result == SB_OK)
        result = sbi_heat_check_elements(body, def->perfusion, "perfusion", error);
    if (result == SB_OK)
        result = sbi_heat_check_elements(body, def->metabolic, "metabolic heat", error);
    return result;
}

/* ---- making ---- */

static void sbi_heat_layout(sb_heat *heat, sbi_arena *arena)
{
    size_t n = (size_t)heat->node_count, q = (size_t)heat->entry_count;
    double **by_entry[] = {&heat->conduction, &heat->matrix, &heat->factor};
    double **by_node[] = {&heat->volume,    &heat->capacity,  &heat->latent,  &heat->perfusion,
                          &heat->metabolic, &heat->blood,     &heat->rise,    &heat->residual,
                          &heat->change,    &heat->direction, &heat->product, &heat->smooth};
    for (size_t k = 0; k < sizeof by_entry / sizeof *by_entry; k++)
        *by_entry[k] = (double *)sbi_arena_take(arena, q, sizeof(double));
    for (size_t k = 0; k < sizeof by_node / sizeof *by_node; k++)
        *by_node[k] = (double *)sbi_arena_take(arena, n, sizeof(double));
    heat->temperature = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    heat->damage = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    heat->new_damage = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    heat->target = (sb_real *)sbi_arena_take(arena, n, sizeof(sb_real));
    if (heat->def.stiffening != 0)
        heat->stiffness = (sb_real *)sbi_arena_take(arena, (size_t)heat->body->domain.cell_count, sizeof(sb_real));
    heat->row_start = (int *)sbi_arena_take(arena, n + 1, sizeof(int));
    heat->columns = (int *)sbi_arena_take(arena, q, sizeof(int));
    heat->diagonal = (int *)sbi_arena_take(arena, n, sizeof(int));
    heat->held = (unsigned char *)sbi_arena_take(arena, n, 1);
}

/* Takes the arrays, and fills the pattern. */
static int sbi_heat_take_memory(sb_heat *heat)
{
    const sb_body *body = heat->body;
    size_t n = (size_t)heat->node_count;
    sbi_arena arena = {NULL, 0, 0};
    int *lists = (int *)sbi_alloc(&body->allocator, 2 * n + 1, sizeof(int));
    if (!lists)
        return 0;
    heat->entry_count = sbi_heat_pattern(body, lists + n + 1, lists, NULL, NULL);
    sbi_heat_layout(heat, &arena);
    if (heat->entry_count > 0 && !arena.overflow)
        heat->memory = sbi_alloc_zeroed(&body->allocator, arena.used, 1);
    if (heat->memory) {
        arena.base = (unsigned char *)heat->memory;
        arena.used = 0;
        sbi_heat_layout(heat, &arena);
        sbi_heat_pattern(body, lists, heat->row_start, heat->columns, heat->diagonal);
    }
    sbi_free(&body->allocator, lists);
    return heat->memory != NULL;
}

static void sbi_heat_release(sb_heat *heat)
{
    sbi_free(&heat->body->allocator, heat->memory);
    sbi_free(&heat->body->allocator, heat);
}

SB_API sb_result sb_heat_create(sb_body *body, const sb_heat_def *def, sb_heat **out, sb_error *error)
{
    sb_heat *heat;
    sb_result result;
    if (!body || !def || !out)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "sb_heat_create needs a body, a def and a place for the heat");
    result = sbi_heat_check_def(body, def, error);
    if (result != SB_OK)
        return result;
    heat = (sb_heat *)sbi_alloc_zeroed(&body->allocator, 1, sizeof *heat);
    if (!heat)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for heat");
    heat->body = body;
    heat->def = *def;
    heat->def.regions = NULL;
    heat->def.perfusion = heat->def.metabolic = NULL;
    heat->node_count = body->domain.node_count;
    result = sbi_heat_take_memory(heat)
                 ? SB_OK
                 : sbi_fail(error, SB_ERROR_MEMORY, "no memory for heat of %d nodes", heat->node_count);
    if (result == SB_OK)
        result = sbi_heat_join(heat, error);
    if (result != SB_OK) {
        sbi_heat_release(heat);
        return result;
    }
    sbi_heat_integrate(heat, def);
    for (int i = 0; i < heat->node_count; i++) {
        heat->held[i] = !(heat->volume[i] > 0);
        heat->target[i] = heat->temperature[i] = def->start;
    }
    body->assembly.cell_stiffness = heat->stiffness;
    sbi_heat_stiffen(heat);
    *out = heat;
    return SB_OK;
}

SB_API void sb_heat_destroy(sb_heat *heat)
{
    if (!heat)
        return;
    sbi_heat_leave(heat);
    if (heat->stiffness) {
        heat->body->assembly.cell_stiffness = NULL;
        sbi_body_cells_stiffened(heat->body);
    }
    sbi_heat_free_sources(heat, heat->loaded, heat->loaded_count);
    sbi_heat_free_sources(heat, heat->sources, heat->source_count);
    sbi_heat_release(heat);
}
