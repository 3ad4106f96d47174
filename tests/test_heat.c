/* Heat: balances, blood that stops, latent heat, stiffness that follows, undo, states, recordings, failures, memory. */
#include <stdlib.h>

#include "check.h"
#include "heat_scene.h"

static const sb_element_type types[5] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};

static sb_mesh block(sb_element_type type)
{
    return scene_box(type, 4, 3, 3, sb_v3(REAL(0.04), REAL(0.03), REAL(0.03)), 0.2);
}

/* Everything that heats and cools. */
static void dress(sb_heat *heat, const sb_mesh *mesh, int ids[4])
{
    int face_count, corners, *faces = heat_faces(mesh, 0, 0, &face_count, &corners);
    const int elements[2] = {0, 5};
    CHECK_OK(sb_heat_add_source(heat, sb_v3(REAL(0.01), REAL(0.01), REAL(0.01)),
                                sb_v3(REAL(0.02), REAL(0.01), REAL(0.01)), REAL(0.003), 8, ids, NULL));
    CHECK_OK(sb_heat_add_element_source(heat, elements, 2, 20000, ids + 1, NULL));
    CHECK_OK(sb_heat_add_convection(heat, faces, face_count, corners, 50, 290, ids + 2, NULL));
    free(faces);
    faces = heat_faces(mesh, 1, 0, &face_count, &corners);
    CHECK_OK(sb_heat_add_flux(heat, faces, face_count, corners, -200, ids + 3, NULL));
    free(faces);
    heat_hold_plane(heat, mesh, 0, 0.04, 305);
}

static double largest_flow(const sb_heat_flows *f)
{
    return fabs(f->source) + fabs(f->metabolic) + fabs(f->perfused) + fabs(f->convected) + fabs(f->held) +
           fabs(f->stored);
}

/* Of each step and of all together, on every element; powers are what was asked for. */
static void test_balance(void)
{
    for (int t = 0; t < 5; t++) {
        sb_mesh mesh = block(types[t]);
        sb_body *body = heat_body(&mesh, t % 2 ? SB_INTEGRATION_BBAR : SB_INTEGRATION_AUTO, NULL);
        sb_heat_def def = sb_default_heat_def();
        sb_heat *heat;
        sb_heat_info info;
        sb_heat_flows sums;
        int ids[4];
        sb_real power;
        def.tissue.metabolic = 3000;
        heat = heat_of(body, &def);
        dress(heat, &mesh, ids);
        for (int k = 0; k < 40; k++) {
            CHECK_OK(sb_heat_step(heat, REAL(0.5 + 0.02 * k), &info, NULL));
            CHECK_NEAR(info.flows.error / largest_flow(&info.flows), 0, scene_tolerance(1e-10, 100));
            CHECK(info.iterations > 0 && info.systems == 1 && info.residual < 1e-3);
        }
        sums = sb_heat_balance(heat);
        CHECK_NEAR(sums.error / largest_flow(&sums), 0, scene_tolerance(1e-10, 100));
        CHECK(sums.source > 0 && sums.metabolic > 0 && sums.convected > 0 && sums.held > 0 && sums.stored > 0);
        CHECK_OK(sb_heat_power(heat, ids[0], &power));
        CHECK_NEAR(power, 8, scene_tolerance(1e-12, 100));
        CHECK_OK(sb_heat_power(heat, ids[3], &power));
        CHECK_NEAR(power, -200 * 0.04 * 0.03, scene_tolerance(1e-12, 100));
        CHECK_OK(sb_heat_power(heat, ids[2], &power));
        CHECK(power < 0);
        CHECK(info.highest == sb_heat_temperatures(heat)[info.highest_node] && info.highest > 340);
        CHECK(info.dead_volume == sb_heat_dead_volume(heat) && info.dead_volume > 0);
        /* on to steady: nothing is stored any more */
        CHECK_OK(sb_heat_set_source(heat, ids[0], 1));
        CHECK_OK(sb_heat_solve_steady(heat, &info, NULL));
        CHECK(info.flows.stored == 0 && sums.stored == sb_heat_balance(heat).stored);
        CHECK_NEAR(info.flows.error / largest_flow(&info.flows), 0, scene_tolerance(1e-10, 100));
        CHECK_OK(sb_heat_step(heat, 1000, &info, NULL));
        CHECK(fabs(info.flows.stored) < scene_tolerance(1e-6, 1e4) * largest_flow(&info.flows) ||
              info.dead_volume > 0); /* more dies, and blood stops */
        sb_heat_destroy(heat);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* Nothing happens where nothing heats: to the last bit. */
static void test_still(void)
{
    for (int t = 0; t < 5; t++) {
        sb_mesh mesh = block(types[t]);
        sb_body *body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
        sb_heat_def def = sb_default_heat_def();
        sb_heat *heat = heat_of(body, &def);
        sb_heat_info info;
        for (int k = 0; k < 5; k++)
            CHECK_OK(sb_heat_step(heat, 1, &info, NULL));
        for (int i = 0; i < mesh.node_count; i++)
            CHECK(sb_heat_temperatures(heat)[i] == def.start && sb_heat_damage(heat)[i] == 0);
        CHECK(info.iterations == 0);
        sb_heat_destroy(heat);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* Lumped: a hot wall neither cools nor overheats its neighbours, whatever dt. */
static void test_bounds(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 6, 3, 3, sb_v3(REAL(0.06), REAL(0.03), REAL(0.03)), 0);
    sb_body *body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
    sb_heat_def def = sb_default_heat_def();
    sb_heat *heat = heat_of(body, &def);
    const double steps[4] = {1e-3, 0.1, 10, 1e4};
    heat_hold_plane(heat, &mesh, 0, 0, 360);
    for (int k = 0; k < 4; k++) {
        sb_heat_reset(heat);
        for (int n = 0; n < 3; n++)
            CHECK_OK(sb_heat_step(heat, REAL(steps[k]), NULL, NULL));
        for (int i = 0; i < mesh.node_count; i++)
            CHECK((double)sb_heat_temperatures(heat)[i] > 310.15 - 1e-4 &&
                  (double)sb_heat_temperatures(heat)[i] < 360 + 1e-4);
    }
    sb_heat_destroy(heat);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* Blood cools what lives: with it off less power is carried away and more dies. */
static void test_blood(void)
{
    sb_mesh mesh = block(SB_TET4);
    double dead[2];
    for (int keeps = 0; keeps < 2; keeps++) {
        sb_body *body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
        sb_heat_def def = sb_default_heat_def();
        sb_heat *heat;
        sb_real *shares = (sb_real *)malloc((size_t)mesh.node_count * sizeof *shares);
        def.keeps_perfusion = keeps;
        heat = heat_of(body, &def);
        CHECK_OK(sb_heat_add_source(heat, sb_v3(REAL(0.02), REAL(0.015), REAL(0.015)),
                                    sb_v3(REAL(0.02), REAL(0.015), REAL(0.015)), REAL(0.004), 10, NULL, NULL));
        for (int k = 0; k < 200; k++)
            CHECK_OK(sb_heat_step(heat, 1, NULL, NULL));
        dead[keeps] = (double)sb_heat_dead_volume(heat);
        sb_heat_dead_shares(heat, shares);
        for (int i = 0; i < mesh.node_count; i++)
            CHECK_NEAR(shares[i], 1 - exp(-(double)sb_heat_damage(heat)[i]), scene_tolerance(1e-12, 10));
        free(shares);
        sb_heat_destroy(heat);
        sb_body_destroy(body);
    }
    CHECK(dead[0] > 1.1 * dead[1] && dead[1] > 1e-6 && dead[0] < 36e-6);
    sb_mesh_free(&mesh);
}

/* Damage does not depend on dt once temperatures are known: the body is held and rises in one step or in many. */
static void test_damage_steps(void)
{
    sb_mesh mesh = scene_box(SB_HEX8, 1, 1, 1, sb_v3(REAL(0.01), REAL(0.01), REAL(0.01)), 0);
    sb_body *body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
    sb_heat_def def = sb_default_heat_def();
    double damage[2];
    for (int fine = 0; fine < 2; fine++) {
        sb_heat *heat = heat_of(body, &def);
        int steps = fine ? 500 : 1;
        for (int k = 1; k <= steps; k++) {
            sb_real kelvin = REAL(310.15 + 25.0 * k / steps);
            for (int i = 0; i < mesh.node_count; i++)
                CHECK_OK(sb_heat_hold(heat, &i, 1, &kelvin, 1, NULL));
            CHECK_OK(sb_heat_step(heat, REAL(10.0 / steps), NULL, NULL));
        }
        damage[fine] = (double)sb_heat_damage(heat)[3];
        sb_heat_destroy(heat);
    }
    CHECK_NEAR(damage[0] / damage[1], 1, 8e-3); /* trapezoids of 1 K: (0.28)^2/12 */
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* Latent heat in space: conserved, bounded, and slower than without. */
static void test_latent(void)
{
    sb_mesh mesh = block(SB_TET4);
    double highest[2];
    for (int latent = 0; latent < 2; latent++) {
        sb_body *body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
        sb_heat_def def = sb_default_heat_def();
        sb_heat *heat;
        sb_heat_info info;
        sb_heat_flows sums;
        int systems = 0;
        def.tissue.latent_heat = latent ? REAL(1.8e9) : 0;
        heat = heat_of(body, &def);
        CHECK_OK(sb_heat_add_source(heat, sb_v3(REAL(0.02), REAL(0.015), REAL(0.015)),
                                    sb_v3(REAL(0.02), REAL(0.015), REAL(0.015)), REAL(0.004), 60, NULL, NULL));
        for (int k = 0; k < 60; k++) {
            CHECK_OK(sb_heat_step(heat, 1, &info, NULL));
            systems += info.systems;
        }
        highest[latent] = (double)info.highest;
        CHECK(latent ? systems > 60 && systems < 600 : systems == 60);
        sums = sb_heat_balance(heat);
        CHECK_NEAR(sums.error / largest_flow(&sums), 0, scene_tolerance(1e-8, 1000));
        sb_heat_destroy(heat);
        sb_body_destroy(body);
    }
    CHECK(highest[0] > 450 && highest[1] > 372 && highest[1] < 400);
    sb_mesh_free(&mesh);
}

/* Steps so short that a rise is next to the rounding of a temperature; latent heat over hundredths of a kelvin. */
static void test_latent_hard(void)
{
    static const double steps[6] = {1e-4, 1e-6, 1e-8, 600, 60, 10}; /* s */
    sb_mesh mesh = block(SB_TET4);
    for (int k = 0; k < 6; k++) {
        sb_body *body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
        sb_heat_def def = sb_default_heat_def();
        sb_vec3 middle = sb_v3(REAL(0.02), REAL(0.015), REAL(0.015));
        sb_heat *heat;
        int is_short = steps[k] < 1;
        def.tissue.latent_heat = REAL(1.8e9);
        if (is_short)
            def.start = 373;
        else
            def.latent_high = def.latent_low + REAL(SB_REAL_IS_FLOAT ? 0.3 : 0.01); /* 1e4 roundings of it */
        heat = heat_of(body, &def);
        CHECK_OK(sb_heat_add_source(heat, middle, middle, REAL(0.003), is_short ? 30 : 100, NULL, NULL));
        for (int n = 0; n < (is_short ? 5 : 40); n++) {
            sb_error error;
            if (!CHECK_OK(sb_heat_step(heat, REAL(steps[k]), NULL, &error)))
                printf("%g s: %s\n", steps[k], error.message);
        }
        sb_heat_destroy(heat);
        sb_body_destroy(body);
    }
    sb_mesh_free(&mesh);
}

/* Two tissues, and fields by element that say the same. */
static void test_regions(void)
{
    sb_mesh mesh = block(SB_HEX8);
    sb_heat_def def = sb_default_heat_def();
    sb_heat_region region;
    sb_real *perfusion = (sb_real *)malloc((size_t)mesh.element_count * sizeof *perfusion);
    sb_real *metabolic = (sb_real *)malloc((size_t)mesh.element_count * sizeof *metabolic);
    sb_heat *heat;
    sb_body *body;
    sb_real *first = (sb_real *)malloc((size_t)mesh.node_count * sizeof *first);
    mesh.regions = (int *)malloc((size_t)mesh.element_count * sizeof(int));
    memset(&region, 0, sizeof region);
    region.region = 7;
    region.tissue = sb_default_heat_tissue();
    region.tissue.perfusion = 90000;
    region.tissue.metabolic = 40000;
    for (int e = 0; e < mesh.element_count; e++) {
        mesh.regions[e] = e % 3 == 0 ? 7 : 2;
        perfusion[e] = mesh.regions[e] == 7 ? 90000 : def.tissue.perfusion;
        metabolic[e] = mesh.regions[e] == 7 ? 40000 : 0;
    }
    body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
    for (int by_element = 0; by_element < 2; by_element++) {
        def.regions = by_element ? NULL : &region;
        def.region_count = !by_element;
        def.perfusion = by_element ? perfusion : NULL;
        def.metabolic = by_element ? metabolic : NULL;
        heat = heat_of(body, &def);
        CHECK_OK(sb_heat_solve_steady(heat, NULL, NULL));
        for (int i = 0; i < mesh.node_count; i++) {
            if (by_element)
                CHECK(sb_heat_temperatures(heat)[i] == first[i] && (double)first[i] > 310.15);
            first[i] = sb_heat_temperatures(heat)[i];
        }
        sb_heat_destroy(heat);
    }
    sb_body_destroy(body);
    free(mesh.regions);
    mesh.regions = NULL;
    sb_mesh_free(&mesh);
    free(perfusion), free(metabolic), free(first);
}

/* ---- stiffness that follows ---- */

/* A column that sags in a static solve; half of it may be dead. */
static double sag(sb_element_type type, sb_integration integration, sb_material material, int all_dead, double factor)
{
    sb_mesh mesh = scene_box(type, 3, 2, 2, sb_v3(REAL(0.06), REAL(0.02), REAL(0.02)), 0.2);
    sb_body_def own = sb_default_body_def();
    sb_heat_def def = sb_default_heat_def();
    sb_body *body;
    sb_heat *heat = NULL;
    double way = 0;
    own.mesh = &mesh;
    own.integration = integration;
    own.material = material;
    own.gravity = sb_v3(0, 0, -2);
    body = scene_body(&own);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    if (all_dead) {
        sb_energy energy;
        sb_real *factors = (sb_real *)malloc((size_t)mesh.element_count * sizeof *factors);
        def.stiffening = REAL(factor - 1);
        heat = heat_of(body, &def);
        CHECK_OK(sb_body_solve_static(body, NULL, NULL)); /* it is strained before it stiffens */
        CHECK_OK(sb_body_energy(body, &energy));
        for (int i = 0; i < mesh.node_count; i++) {
            sb_real kelvin = 400;
            CHECK_OK(sb_heat_hold(heat, &i, 1, &kelvin, 1, NULL));
        }
        CHECK_OK(sb_heat_step(heat, 5, NULL, NULL));
        sb_heat_stiffness(heat, factors);
        for (int e = 0; e < mesh.element_count; e++)
            CHECK_NEAR(factors[e], factor, scene_tolerance(1e-9, 100));
        way = (double)energy.elastic;
        CHECK_OK(sb_body_energy(body, &energy));
        CHECK_NEAR((double)energy.elastic / way, factor, scene_tolerance(1e-9, 1e4));
        free(factors);
    }
    CHECK_OK(sb_body_solve_static(body, NULL, NULL));
    way = (double)sb_body_displacements(body)[mesh.node_count - 1].z;
    if (heat) {
        sb_mat3 stress;
        CHECK_OK(sb_body_stress(body, 0, 0, &stress));
    }
    sb_heat_destroy(heat);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return way;
}

static void test_stiffness(void)
{
    const double factor = 3;
    const sb_real g = REAL(0.4), tau = 1;
    for (int t = 0; t < 5; t++)
        for (int k = 0; k < 4; k++) {
            sb_material soft =
                k == 0   ? sb_material_corotated(5000, REAL(0.4), 1000)
                : k == 1 ? sb_material_neo_hookean(5000, REAL(0.4), 1000)
                : k == 2 ? sb_material_neo_hookean_isochoric(REAL(900), REAL(1e-4), 1000)
                         : sb_material_with_prony(sb_material_neo_hookean(5000, REAL(0.4), 1000), &g, &tau, 1);
            sb_material hard =
                k == 0   ? sb_material_corotated(REAL(5000 * factor), REAL(0.4), 1000)
                : k == 1 ? sb_material_neo_hookean(REAL(5000 * factor), REAL(0.4), 1000)
                : k == 2 ? sb_material_neo_hookean_isochoric(REAL(900 * factor), REAL(1e-4 / factor), 1000)
                         : sb_material_with_prony(sb_material_neo_hookean(REAL(5000 * factor), REAL(0.4), 1000), &g,
                                                  &tau, 1);
            sb_integration integration = (t + k) % 2 && types[t] != SB_TET4 ? SB_INTEGRATION_BBAR : SB_INTEGRATION_AUTO;
            double wanted = sag(types[t], integration, hard, 0, factor);
            CHECK_NEAR(sag(types[t], integration, soft, 1, factor) / wanted, 1, scene_tolerance(1e-4, 1e4));
        }
}

/* Stepped bodies follow too, without being reset, by every integrator. */
static void test_moving(void)
{
    static const sb_integrator integrators[4] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA, SB_CENTRAL_DIFFERENCE};
    for (int k = 0; k < 4; k++) {
        sb_mesh mesh = scene_box(SB_TET4, 4, 2, 2, sb_v3(REAL(0.04), REAL(0.02), REAL(0.02)), 0.2);
        sb_body_def own = sb_default_body_def();
        sb_heat_def def = sb_default_heat_def();
        sb_real kelvin = 400;
        sb_body *body;
        sb_heat *heat;
        double before, after;
        own.mesh = &mesh;
        own.material = sb_material_corotated(3000, REAL(0.4), 1000);
        own.gravity = sb_v3(0, 0, REAL(-9.81));
        own.integrator = integrators[k];
        own.damping_mass = 30;
        body = scene_body(&own);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        def.stiffening = 4;
        heat = heat_of(body, &def);
        for (int n = 0; n < 100; n++)
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        before = (double)sb_body_displacements(body)[mesh.node_count - 1].z;
        for (int i = 0; i < mesh.node_count; i++)
            CHECK_OK(sb_heat_hold(heat, &i, 1, &kelvin, 1, NULL));
        for (int n = 0; n < 100; n++) {
            CHECK_OK(sb_heat_step(heat, REAL(0.1), NULL, NULL));
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        }
        after = (double)sb_body_displacements(body)[mesh.node_count - 1].z;
        CHECK(before < 0 && after / before > 0.15 && after / before < 0.27); /* a fifth; the soft one turns more */
        sb_heat_destroy(heat);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* ---- states, recordings, threads ---- */

static void heat_on(sb_body *body, sb_heat *heat, const int ids[4], int from, int to)
{
    for (int k = from; k < to; k++) {
        CHECK_OK(sb_heat_set_source(heat, ids[0], REAL(6 + k)));
        if (k == 3)
            CHECK_OK(sb_heat_set_convection(heat, ids[2], 80, 285));
        CHECK_OK(sb_heat_step(heat, 1, NULL, NULL));
        CHECK_OK(sb_body_step(body, REAL(0.02), NULL));
    }
}

static sb_body *moving(const sb_mesh *mesh, sb_jobs jobs, sb_heat **heat)
{
    sb_body_def own = sb_default_body_def();
    sb_heat_def def = sb_default_heat_def();
    sb_body *body;
    own.mesh = mesh;
    own.material = sb_material_corotated(3000, REAL(0.4), 1000);
    own.gravity = sb_v3(0, 0, REAL(-9.81));
    own.jobs = jobs;
    body = scene_body(&own);
    scene_fix_plane(body, mesh, 0, 0, SB_XYZ);
    def.stiffening = 4;
    *heat = heat_of(body, &def);
    return body;
}

static void test_state(void)
{
    sb_jobs none;
    sb_mesh mesh = block(SB_TET10);
    sb_heat *heat, *twin, *plain = NULL;
    sb_body *body, *other, *cold = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
    sb_heat_def def = sb_default_heat_def();
    size_t size;
    unsigned char *state, *ends[3];
    sb_error error;
    int ids[4], i = 3;
    memset(&none, 0, sizeof none);
    body = moving(&mesh, none, &heat);
    other = moving(&mesh, none, &twin);
    dress(heat, &mesh, ids);
    heat_on(body, heat, ids, 0, 4);
    size = sb_body_state_size(body);
    state = (unsigned char *)malloc(size);
    CHECK_OK(sb_body_state_save(body, state, size));
    heat_on(body, heat, ids, 4, 8);
    for (int k = 0; k < 3; k++)
        ends[k] = (unsigned char *)malloc(size);
    CHECK_OK(sb_body_state_save(body, ends[0], size));
    if (!CHECK_OK(sb_body_state_load(other, state, size, &error)))
        printf("%s\n", error.message);
    heat_on(other, twin, ids, 4, 8);
    CHECK_OK(sb_body_state_save(other, ends[1], size));
    CHECK(memcmp(ends[0], ends[1], size) == 0);
    CHECK(sb_body_state_hash(body) == sb_body_state_hash(other));
    CHECK_OK(sb_body_state_load(body, state, size, &error)); /* back in time */
    heat_on(body, heat, ids, 4, 8);
    CHECK_OK(sb_body_state_save(body, ends[2], size));
    CHECK(memcmp(ends[0], ends[2], size) == 0);
    /* others refuse it, damaged ones are refused; nothing changes */
    CHECK_RESULT(sb_body_state_load(cold, state, size, &error), SB_ERROR_STATE);
    def.tissue.capacity = 3000000;
    def.stiffening = 4;
    CHECK_OK(sb_heat_create(cold, &def, &plain, &error));
    CHECK(sb_body_state_load(cold, state, size, &error) != SB_OK);
    for (size_t at = 0; at < size; at += 1 + size / 200) {
        state[at] ^= 0x40;
        CHECK(sb_body_state_load(other, state, size, &error) != SB_OK);
        state[at] ^= 0x40;
    }
    CHECK_OK(sb_body_state_save(other, ends[2], size));
    CHECK(memcmp(ends[1], ends[2], size) == 0);
    CHECK_OK(sb_heat_release(twin, &i, 1, &error));
    CHECK(sb_body_state_hash(body) == sb_body_state_hash(other)); /* it was not held */
    CHECK_OK(sb_heat_set_blood(twin, 300));
    CHECK(sb_body_state_hash(body) != sb_body_state_hash(other));
    for (int k = 0; k < 3; k++)
        free(ends[k]);
    free(state);
    sb_heat_destroy(heat), sb_heat_destroy(twin), sb_heat_destroy(plain);
    sb_body_destroy(body), sb_body_destroy(other), sb_body_destroy(cold);
    sb_mesh_free(&mesh);
}

static void test_recording(void)
{
    sb_jobs none;
    sb_mesh mesh = block(SB_TET4);
    sb_heat *heat, *twin;
    sb_body *body, *other;
    sb_recording *recording = NULL;
    sb_recording_report report;
    sb_real *temperatures;
    int ids[4], late, held = 5;
    memset(&none, 0, sizeof none);
    body = moving(&mesh, none, &heat);
    other = moving(&mesh, none, &twin);
    temperatures = (sb_real *)malloc((size_t)mesh.node_count * sizeof *temperatures);
    for (int i = 0; i < mesh.node_count; i++)
        temperatures[i] = REAL(310 + 0.1 * (i % 9));
    CHECK_OK(sb_recording_start(body, 1, NULL, &recording, NULL));
    dress(heat, &mesh, ids);
    heat_on(body, heat, ids, 0, 4);
    CHECK_OK(sb_heat_add_node_source(heat, &held, 1, NULL, 2, &late, NULL));
    CHECK_OK(sb_heat_hold(heat, &held, 1, temperatures, 1, NULL));
    CHECK_OK(sb_heat_set_temperatures(heat, temperatures, NULL));
    CHECK_OK(sb_heat_set_blood(heat, 309));
    heat_on(body, heat, ids, 4, 6);
    CHECK_OK(sb_heat_release(heat, &held, 1, NULL));
    CHECK_OK(sb_heat_remove(heat, ids[1]));
    CHECK_OK(sb_heat_solve_steady(heat, NULL, NULL));
    heat_on(body, heat, ids, 6, 8);
    sb_heat_reset(heat);
    heat_on(body, heat, ids, 8, 9);
    sb_recording_stop(recording);
    if (!CHECK_OK(sb_recording_replay(recording, other, &report)))
        printf("step %d: %s\n", report.step, report.error.message);
    CHECK(sb_body_state_hash(body) == sb_body_state_hash(other));
    sb_recording_destroy(recording);
    free(temperatures);
    sb_heat_destroy(heat), sb_heat_destroy(twin);
    sb_body_destroy(body), sb_body_destroy(other);
    sb_mesh_free(&mesh);
}

static void test_threads(void)
{
    sb_mesh mesh = block(SB_TET4);
    uint64_t hashes[3];
    for (int k = 0; k < 3; k++) {
        int workers = k + 1, ids[4];
        sb_heat *heat;
        sb_body *body = moving(&mesh, scene_jobs(&workers), &heat);
        dress(heat, &mesh, ids);
        heat_on(body, heat, ids, 0, 6);
        hashes[k] = sb_body_state_hash(body);
        sb_heat_destroy(heat);
        sb_body_destroy(body);
    }
    CHECK(hashes[0] == hashes[1] && hashes[0] == hashes[2]);
    sb_mesh_free(&mesh);
}

/* ---- failures ---- */

/* A def with one thing wrong is refused by name. */
static void refused(sb_body *body, const sb_heat_def *def, sb_result result, const char *word)
{
    sb_heat *heat = NULL;
    sb_error error;
    CHECK_RESULT(sb_heat_create(body, def, &heat, &error), result);
    CHECK(!heat && strstr(error.message, word) != NULL);
}

static void test_defs(void)
{
    sb_mesh mesh = block(SB_TET4);
    sb_body *body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL), *live;
    sb_body_def own = sb_default_body_def();
    sb_heat_def def;
    sb_heat_region regions[2];
    sb_heat *heat = NULL, *second = NULL;
    sb_real *values = (sb_real *)calloc((size_t)mesh.element_count, sizeof *values);
    sb_error error;
    memset(regions, 0, sizeof regions);
    regions[0].tissue = regions[1].tissue = sb_default_heat_tissue();
    memset(&def, 0, sizeof def);
    refused(body, &def, SB_ERROR_ARGUMENT, "sb_default_heat_def");
    def = sb_default_heat_def();
    def.tissue.conductivity = 0;
    refused(body, &def, SB_ERROR_ARGUMENT, "conductivity");
    def = sb_default_heat_def();
    def.tissue.capacity = -1;
    refused(body, &def, SB_ERROR_ARGUMENT, "capacity");
    def = sb_default_heat_def();
    def.tissue.perfusion = -1;
    refused(body, &def, SB_ERROR_ARGUMENT, "perfusion");
    def = sb_default_heat_def();
    def.blood = 0;
    refused(body, &def, SB_ERROR_ARGUMENT, "blood");
    def = sb_default_heat_def();
    def.latent_high = def.latent_low;
    refused(body, &def, SB_ERROR_ARGUMENT, "latent_low");
    def = sb_default_heat_def();
    def.stiffening = -1;
    refused(body, &def, SB_ERROR_ARGUMENT, "stiffening");
    def = sb_default_heat_def();
    def.tolerance = 0;
    refused(body, &def, SB_ERROR_ARGUMENT, "tolerance");
    def = sb_default_heat_def();
    def.regions = regions;
    def.region_count = 2;
    refused(body, &def, SB_ERROR_ARGUMENT, "region 0 twice");
    regions[1].region = 9;
    refused(body, &def, SB_ERROR_INDEX, "region 9");
    def = sb_default_heat_def();
    def.perfusion = values;
    values[4] = -1;
    refused(body, &def, SB_ERROR_ARGUMENT, "element 4");
    check_bad_numbers();
    values[4] = REAL(NAN);
    refused(body, &def, SB_ERROR_NOT_FINITE, "element 4");
    def = sb_default_heat_def();
    def.tissue.metabolic = REAL(NAN);
    refused(body, &def, SB_ERROR_NOT_FINITE, "metabolic");
    def = sb_default_heat_def();
    def.log_frequency = REAL(INFINITY);
    refused(body, &def, SB_ERROR_NOT_FINITE, "log_frequency");
    def = sb_default_heat_def();
    CHECK_OK(sb_heat_create(body, &def, &heat, &error));
    CHECK_RESULT(sb_heat_create(body, &def, &second, &error), SB_ERROR_ARGUMENT);
    CHECK(!second && strstr(error.message, "already") != NULL);
    own.mesh = &mesh;
    own.material = sb_material_corotated(5000, REAL(0.4), 1000);
    own.slack = 1;
    live = scene_body(&own);
    refused(live, &def, SB_ERROR_UNSUPPORTED, "slack");
    sb_heat_destroy(heat);
    CHECK_OK(sb_heat_create(body, &def, &heat, &error)); /* its place is free again */
    sb_heat_destroy(heat);
    sb_body_destroy(body), sb_body_destroy(live);
    free(values);
    sb_mesh_free(&mesh);
}

static void test_calls(void)
{
    sb_mesh mesh = block(SB_HEX8);
    sb_body *body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
    sb_heat_def def = sb_default_heat_def();
    sb_heat *heat = heat_of(body, &def);
    int bad_node = mesh.node_count, node = 2, bad_element = mesh.element_count, id = -7, corners, count;
    int *faces = heat_faces(&mesh, 0, 0, &count, &corners), inner[4];
    sb_real kelvin[2] = {300, -1}, shares[2] = {REAL(0.5), REAL(0.4)}, power;
    const int nodes[2] = {1, 2};
    uint64_t hash = sb_body_state_hash(body);
    sb_error error;
    CHECK_RESULT(sb_heat_hold(heat, &bad_node, 1, kelvin, 1, &error), SB_ERROR_INDEX);
    CHECK_INT(error.node, bad_node);
    CHECK_RESULT(sb_heat_hold(heat, nodes, 2, kelvin, 0, &error), SB_ERROR_ARGUMENT);
    CHECK_INT(error.node, 2);
    CHECK_RESULT(sb_heat_release(heat, &bad_node, 1, &error), SB_ERROR_INDEX);
    CHECK_RESULT(sb_heat_add_node_source(heat, nodes, 2, shares, 1, &id, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "0.9") != NULL);
    CHECK_RESULT(sb_heat_add_node_source(heat, &bad_node, 1, NULL, 1, &id, &error), SB_ERROR_INDEX);
    CHECK_INT(error.node, bad_node);
    CHECK_RESULT(sb_heat_add_element_source(heat, &bad_element, 1, 1, &id, &error), SB_ERROR_INDEX);
    CHECK_INT(error.element, bad_element);
    CHECK_RESULT(sb_heat_add_convection(heat, faces, count, corners, -1, 300, &id, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_heat_add_convection(heat, faces, count, corners, 1, 0, &id, &error), SB_ERROR_ARGUMENT);
    for (int k = 0; k < 4; k++)
        inner[k] = faces[k] + 1; /* one layer in: nodes go along x first */
    CHECK_RESULT(sb_heat_add_flux(heat, inner, 1, corners, 1, &id, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "between") != NULL || strstr(error.message, "no face") != NULL);
    CHECK_RESULT(sb_heat_set_source(heat, 1, 1), SB_ERROR_INDEX);
    CHECK_RESULT(sb_heat_remove(heat, 1), SB_ERROR_INDEX);
    CHECK_RESULT(sb_heat_power(heat, 1, &power), SB_ERROR_INDEX);
    CHECK_RESULT(sb_heat_set_blood(heat, 0), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_heat_step(heat, 0, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK(hash == sb_body_state_hash(body) && id == -7);
    CHECK_OK(sb_heat_add_convection(heat, faces, count, corners, 1, 300, &id, &error));
    CHECK_RESULT(sb_heat_set_source(heat, id, 1), SB_ERROR_INDEX); /* it is none */
    CHECK_OK(sb_heat_set_convection(heat, id, 0, 300));
    CHECK_OK(sb_heat_remove(heat, id));
    CHECK_OK(sb_heat_add_source(heat, sb_v3(0, 0, 0), sb_v3(0, 0, 0), 0, 3, &id, &error)); /* at the nearest node */
    CHECK_OK(sb_heat_power(heat, id, &power));
    CHECK(power == 3);
    CHECK_INT(id, 2);
    CHECK_OK(sb_heat_hold(heat, &node, 1, kelvin, 1, &error));
    check_bad_numbers();
    power = REAL(NAN);
    hash = sb_body_state_hash(body);
    CHECK_RESULT(sb_heat_hold(heat, &node, 1, &power, 1, &error), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_heat_add_source(heat, sb_v3(power, 0, 0), sb_v3(0, 0, 0), 0, 3, &id, &error), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_heat_set_source(heat, id, power), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_heat_step(heat, power, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK(hash == sb_body_state_hash(body));
    free(faces);
    sb_heat_destroy(heat);
    sb_heat_destroy(NULL);
    CHECK(!sb_heat_temperatures(NULL) && sb_heat_dead_volume(NULL) == 0 && sb_heat_balance(NULL).stored == 0);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* Blood that is nearly none cools as its balance with what the tissue makes says, or is refused. */
static void test_faint_blood(void)
{
    static const double perfusions[6] = {1e3, 1, 1e-3, 1e-6, 1e-9, 1e-20};
    sb_mesh mesh = block(SB_TET4);
    for (int k = 0; k < 6; k++) {
        sb_body *body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
        sb_heat_def def = sb_default_heat_def();
        sb_heat *heat;
        sb_result result;
        def.tissue.perfusion = REAL(perfusions[k]);
        def.tissue.metabolic = REAL(perfusions[k]); /* a kelvin above the blood */
        heat = heat_of(body, &def);
        result = sb_heat_solve_steady(heat, NULL, NULL);
        CHECK(result == SB_OK ? k < 5 : k > 2 && result == SB_ERROR_UNCONSTRAINED);
        if (result == SB_OK)
            for (int i = 0; i < mesh.node_count; i++)
                CHECK_NEAR(sb_heat_temperatures(heat)[i] - def.blood, 1, 1e-2);
        sb_heat_destroy(heat);
        sb_body_destroy(body);
    }
    sb_mesh_free(&mesh);
}

/* Steps that fail leave everything as it was. */
static void test_undo(void)
{
    sb_mesh mesh = block(SB_TET4);
    sb_body *body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
    sb_heat_def def = sb_default_heat_def();
    sb_heat *heat;
    sb_heat_info info;
    sb_error error;
    uint64_t hash;
    int id;
    def.stiffening = 1;
    def.max_iterations = 2;
    def.tissue.perfusion = 0;
    heat = heat_of(body, &def);
    memset(&info, 0x5A, sizeof info);
    CHECK_RESULT(sb_heat_solve_steady(heat, NULL, &error), SB_ERROR_UNCONSTRAINED);
    CHECK(error.node >= 0);
    CHECK_OK(sb_heat_add_source(heat, sb_v3(0, 0, 0), sb_v3(0, 0, 0), REAL(0.005), 5, &id, NULL));
    heat_hold_plane(heat, &mesh, 0, 0.04, 320);
    hash = sb_body_state_hash(body);
    CHECK_RESULT(sb_heat_step(heat, 1000, &info, &error), SB_ERROR_NOT_CONVERGED);
    CHECK_RESULT(sb_heat_solve_steady(heat, &info, &error), SB_ERROR_NOT_CONVERGED);
    CHECK(hash == sb_body_state_hash(body) && *(unsigned char *)&info == 0x5A);
    sb_heat_destroy(heat);
    def.max_iterations = 1000;
    heat = heat_of(body, &def);
    CHECK_OK(sb_heat_add_source(heat, sb_v3(0, 0, 0), sb_v3(0, 0, 0), REAL(0.005), -5000, &id, NULL));
    hash = sb_body_state_hash(body);
    CHECK_RESULT(sb_heat_step(heat, 10, &info, &error), SB_ERROR_DIVERGED); /* below 0 K */
    CHECK(error.node >= 0 && hash == sb_body_state_hash(body));
    check_bad_numbers();
    CHECK_OK(sb_heat_set_source(heat, id, SB_REAL_MAX));
    hash = sb_body_state_hash(body);
    CHECK(sb_heat_step(heat, 10, &info, &error) != SB_OK);
    CHECK(hash == sb_body_state_hash(body));
    CHECK_OK(sb_heat_set_source(heat, id, 5));
    CHECK_OK(sb_heat_step(heat, 10, &info, &error));
    sb_heat_destroy(heat);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* After a step of any length the state can be loaded: it succeeds with finite numbers, or is undone. */
static void test_long(void)
{
    const double steps[4] = {1e12, SB_REAL_IS_FLOAT ? 1e24 : 1e200, SB_REAL_IS_FLOAT ? 1e30 : 1e295,
                             0.9 * (double)SB_REAL_MAX};
    sb_mesh mesh = block(SB_TET4);
    for (int k = 0; k < 4; k++) {
        sb_body *body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
        sb_heat_def def = sb_default_heat_def();
        sb_heat *heat;
        sb_error error;
        sb_real kelvin = 400;
        int i = 0;
        size_t size;
        unsigned char *state;
        def.stiffening = 4;
        def.start = 400;
        heat = heat_of(body, &def);
        CHECK_OK(sb_heat_add_element_source(heat, NULL, 0, REAL(1e6), NULL, NULL));
        CHECK_OK(sb_heat_hold(heat, &i, 1, &kelvin, 1, NULL));
        for (int n = 0; n < 3; n++) {
            sb_result result = sb_heat_step(heat, REAL(steps[k]), NULL, &error);
            CHECK(result == SB_OK || result == SB_ERROR_DIVERGED);
        }
        size = sb_body_state_size(body);
        state = (unsigned char *)malloc(size);
        CHECK_OK(sb_body_state_save(body, state, size));
        if (!CHECK_OK(sb_body_state_load(body, state, size, &error)))
            printf("%g s: %s\n", steps[k], error.message);
        free(state);
        sb_heat_destroy(heat);
        sb_body_destroy(body);
    }
    sb_mesh_free(&mesh);
}

/* Every allocation fails in turn; steps have none. */
static void test_memory(void)
{
    sb_mesh mesh = block(SB_TET4);
    sb_heat_def def = sb_default_heat_def();
    scene_memory memory;
    sb_allocator allocator = scene_allocator(&memory);
    sb_body *body, *other;
    sb_heat *heat = NULL, *twin;
    sb_error error;
    int ids[6], live, calls, face_count, corners, *faces = heat_faces(&mesh, 0, 0, &face_count, &corners);
    size_t size;
    void *state;
    memset(&memory, 0, sizeof memory);
    def.stiffening = 2;
    body = heat_body(&mesh, SB_INTEGRATION_AUTO, &allocator);
    live = memory.live;
    for (int n = 1; !heat && n < 100; n++) {
        memory.calls = 0;
        memory.fail_at = n;
        if (sb_heat_create(body, &def, &heat, &error) != SB_OK) {
            CHECK_RESULT(error.result, SB_ERROR_MEMORY);
            CHECK(!heat && memory.live <= live + 1); /* the body keeps its list of parts */
        }
    }
    for (int k = 0; k < 6; k++)
        for (int n = 1; n < 100; n++) {
            sb_result result;
            live = memory.live;
            memory.calls = 0;
            memory.fail_at = n;
            result = k % 2 ? sb_heat_add_convection(heat, faces, face_count, corners, 5, 300, ids + k, &error)
                           : sb_heat_add_source(heat, sb_v3(0, 0, 0), sb_v3(0, 0, 0), REAL(0.01), 5, ids + k, &error);
            if (result == SB_OK)
                break;
            CHECK_RESULT(result, SB_ERROR_MEMORY);
            CHECK_INT(memory.live, live);
        }
    memory.fail_at = 0;
    calls = memory.calls;
    for (int k = 0; k < 20; k++)
        CHECK_OK(sb_heat_step(heat, 1, NULL, NULL));
    CHECK_OK(sb_heat_solve_steady(heat, NULL, NULL));
    CHECK_OK(sb_heat_set_source(heat, ids[0], 3));
    sb_heat_reset(heat);
    CHECK_INT(memory.calls, calls);
    size = sb_body_state_size(body);
    state = malloc(size);
    CHECK_OK(sb_body_state_save(body, state, size));
    other = heat_body(&mesh, SB_INTEGRATION_AUTO, &allocator);
    twin = heat_of(other, &def);
    live = memory.live;
    for (int n = 1; n < 1000; n++) {
        memory.calls = 0;
        memory.fail_at = n;
        if (sb_body_state_load(other, state, size, &error) == SB_OK)
            break;
        CHECK_RESULT(error.result, SB_ERROR_MEMORY);
        CHECK_INT(memory.live, live);
    }
    CHECK(sb_body_state_hash(body) == sb_body_state_hash(other));
    memory.fail_at = 0;
    sb_heat_destroy(heat), sb_heat_destroy(twin);
    sb_body_destroy(body), sb_body_destroy(other);
    CHECK_INT(memory.live, 0);
    free(state);
    free(faces);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(heat, {"balance", test_balance}, {"still", test_still}, {"bounds", test_bounds}, {"blood", test_blood},
            {"damage steps", test_damage_steps}, {"latent", test_latent},
            {"latent, short steps and narrow", test_latent_hard}, {"regions", test_regions},
            {"stiffness", test_stiffness}, {"moving", test_moving}, {"state", test_state},
            {"recording", test_recording}, {"threads", test_threads}, {"defs", test_defs}, {"calls", test_calls},
            {"undo", test_undo}, {"faint blood", test_faint_blood}, {"long steps", test_long}, {"memory", test_memory});
