/* Damping by region: balance against matrices of the regions' own meshes, one scheme and element against another, what
 * it does to motion, states, recordings, meshes that change, threads, refusals and memory. */
#include <stdlib.h>

#include "softbody.h"

#include "check.h"
#include "scene.h"

static const char *const scheme_names[] = {"", "Euler", "Newmark", "generalised alpha"};

/* A shaken box, its regions 3 and 8 on both sides of a slanted plane. */
static sb_mesh two_regions(sb_element_type type, int nx, int ny, int nz)
{
    sb_mesh mesh = scene_box(type, nx, ny, nz, sb_v3(REAL(0.06), REAL(0.03), REAL(0.03)), 0.15);
    int n = sb_element_node_count(type);
    free(mesh.regions);
    mesh.regions = (int *)malloc((size_t)mesh.element_count * sizeof(int)); /* freed as the others are */
    for (int e = 0; e < mesh.element_count && CHECK(mesh.regions); e++) {
        sb_vec3 x = mesh.nodes[mesh.elements[n * e]];
        mesh.regions[e] = (double)x.x + 0.3 * (double)x.y < 0.033 ? 3 : 8;
    }
    return mesh;
}

static sb_body_def damped_def(const sb_mesh *mesh, sb_integrator integrator, sb_material material)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = material;
    def.integrator = integrator;
    def.gravity = sb_v3(REAL(0.3), REAL(-1), REAL(0.5));
    def.tolerance = REAL(scene_tolerance(1e-12, 100));
    def.newton_tolerance = REAL(scene_tolerance(1e-11, 1000));
    def.max_iterations = 5000;
    return def;
}

static sb_body *damped_body(const sb_body_def *def, const sb_real *alpha, const sb_real *beta)
{
    sb_body *body = scene_body(def);
    if (!body)
        return NULL;
    scene_fix_plane(body, def->mesh, 0, 0, SB_XYZ);
    if (alpha) {
        CHECK_OK(sb_body_set_region_damping(body, 3, alpha[0], beta[0], NULL));
        CHECK_OK(sb_body_set_region_damping(body, 8, alpha[1], beta[1], NULL));
    }
    return body;
}

/* ---- balance ---- */

/* out += alpha M v + beta K v of one region, from a body of its elements alone (tet4). */
static void add_region_damping(const sb_mesh *mesh, int region, sb_material material, double alpha, double beta,
                               const sb_vec3 *v, sb_vec3 *out, double *masses)
{
    sb_mesh part = *mesh;
    sb_body_def def = sb_default_body_def();
    sb_vec3 *kv = (sb_vec3 *)calloc((size_t)mesh->node_count, sizeof *kv);
    sb_body *body;
    part.elements = (int *)malloc((size_t)mesh->element_count * 4 * sizeof(int));
    part.regions = NULL;
    part.element_count = 0;
    for (int e = 0; e < mesh->element_count && CHECK(kv && part.elements); e++) {
        double quarter = (double)material.density * (double)sb_mesh_element_volume(mesh, e) / 4;
        if (mesh->regions[e] != region)
            continue;
        memcpy(part.elements + 4 * part.element_count++, mesh->elements + 4 * e, 4 * sizeof(int));
        for (int a = 0; a < 4; a++) {
            int i = mesh->elements[4 * e + a];
            out[i] = sb_v3_madd(out[i], REAL(alpha * quarter), v[i]);
            masses[i] += quarter;
        }
    }
    def.mesh = &part;
    def.material = material;
    body = scene_body(&def);
    if (body && kv) {
        CHECK_OK(sb_body_multiply_tangent(body, SB_TANGENT_EXACT, v, kv, NULL));
        for (int i = 0; i < mesh->node_count; i++)
            out[i] = sb_v3_madd(out[i], REAL(beta), kv[i]);
    }
    sb_body_destroy(body);
    free(part.elements);
    free(kv);
}

/* Largest M a + D v + K u - M g of a free node at the end of a step, over the weight. */
static double off_balance(const sb_body_def *def, sb_body *body, const sb_vec3 *a, const double *alpha,
                          const double *beta)
{
    const sb_mesh *mesh = def->mesh;
    size_t n = (size_t)mesh->node_count;
    sb_vec3 *force = (sb_vec3 *)calloc(n, sizeof *force);
    double *mass = (double *)calloc(n, sizeof *mass), off = 0, weight = 0;
    const sb_vec3 *u = sb_body_displacements(body), *v = sb_body_velocities(body);
    CHECK_OK(sb_body_multiply_tangent(body, SB_TANGENT_EXACT, u, force, NULL));
    add_region_damping(mesh, 3, def->material, alpha[0], beta[0], v, force, mass);
    add_region_damping(mesh, 8, def->material, alpha[1], beta[1], v, force, mass);
    for (size_t i = 0; i < n; i++) {
        sb_vec3 rest = sb_v3_madd(force[i], REAL(mass[i]), sb_v3_sub(a[i], def->gravity));
        weight += mass[i] * (double)sb_v3_norm(def->gravity);
        if (!sb_body_supports(body)[i] && (double)sb_v3_norm(rest) > off)
            off = (double)sb_v3_norm(rest);
    }
    free(force);
    free(mass);
    return off / weight;
}

/* a = what the scheme's rule makes of two velocities; Newmark's goes on from the one before. */
static void next_acceleration(sb_integrator integrator, double dt, const sb_vec3 *v0, const sb_vec3 *v1, int count,
                              sb_vec3 *a)
{
    double ahead = integrator == SB_EULER ? 1 : 2;
    for (int i = 0; i < count; i++)
        a[i] = sb_v3_madd(sb_v3_scale(REAL(1 - ahead), a[i]), REAL(ahead / dt), sb_v3_sub(v1[i], v0[i]));
}

static void check_balance(unsigned long long *seed, sb_integrator integrator)
{
    sb_mesh mesh = two_regions(SB_TET4, 4, 2, 2);
    sb_material material = sb_material_linear(REAL(check_random_in(seed, 2e3, 2e4)), REAL(0.4), 1000);
    sb_body_def def = damped_def(&mesh, integrator, material);
    double alpha[2], beta[2], worst = 0, wrong = 0;
    sb_real ra[2], rb[2], dt = REAL(0.01);
    for (int k = 0; k < 2; k++) {
        ra[k] = REAL(alpha[k] = check_random_in(seed, 0, 5));
        rb[k] = REAL(beta[k] = check_random_in(seed, 0, 0.05));
    }
    sb_body *body = damped_body(&def, ra, rb);
    sb_vec3 *a = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof *a);
    sb_vec3 *before = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof *before);
    const double swapped[2] = {beta[1], beta[0]};
    if (!CHECK(body && a && before))
        return;
    for (int i = 0; i < mesh.node_count; i++)
        a[i] = sb_body_supports(body)[i] ? sb_v3(0, 0, 0) : def.gravity;
    for (int step = 0; step < 6; step++) {
        double off;
        memcpy(before, sb_body_velocities(body), (size_t)mesh.node_count * sizeof *before);
        CHECK_OK(sb_body_step(body, dt, NULL));
        next_acceleration(integrator, (double)dt, before, sb_body_velocities(body), mesh.node_count, a);
        off = off_balance(&def, body, a, alpha, beta);
        worst = off > worst ? off : worst;
        wrong = off_balance(&def, body, a, alpha, swapped);
    }
    CHECK(worst < scene_tolerance(1e-10, 1e5));
    CHECK(wrong > 10 * worst && wrong > 1e-4); /* it can tell whose damping is whose */
    free(a);
    free(before);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_balance(void)
{
    unsigned long long seed = 20;
    for (int round = 0; round < 3; round++) {
        check_balance(&seed, SB_EULER);
        check_balance(&seed, SB_NEWMARK);
    }
}

/* ---- one form against another ---- */

/* Displacements after some steps; the caller frees them. */
static sb_vec3 *swing(const sb_body_def *def, const sb_real *alpha, const sb_real *beta, double dt, int steps)
{
    sb_body *body = damped_body(def, alpha, beta);
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)def->mesh->node_count, sizeof *u);
    for (int i = 0; body && u && i < steps; i++)
        CHECK_OK(sb_body_step(body, REAL(dt), NULL));
    if (body && u)
        memcpy(u, sb_body_displacements(body), (size_t)def->mesh->node_count * sizeof *u);
    sb_body_destroy(body);
    return u;
}

static double largest(const sb_vec3 *u, int count)
{
    double most = 0;
    for (int i = 0; i < count; i++)
        most = (double)sb_v3_norm(u[i]) > most ? (double)sb_v3_norm(u[i]) : most;
    return most;
}

/* Regions that damp alike are a body that damps so. */
static void test_alike(void)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20};
    const sb_real alpha[2] = {REAL(1.5), REAL(1.5)}, beta[2] = {REAL(0.02), REAL(0.02)};
    for (int t = 0; t < 4; t++)
        for (int scheme = SB_EULER; scheme <= SB_GENERALISED_ALPHA; scheme++)
            for (int material = 0; material < 3; material++) {
                sb_mesh mesh = two_regions(types[t], 3, 1, 1);
                sb_body_def def = damped_def(&mesh, (sb_integrator)scheme,
                                             material == 0   ? sb_material_linear(8000, REAL(0.4), 1000)
                                             : material == 1 ? sb_material_corotated(8000, REAL(0.4), 1000)
                                                             : sb_material_stable_neo_hookean(8000, REAL(0.4), 1000));
                sb_vec3 *own = swing(&def, alpha, beta, 0.01, 8), *all;
                double off, most;
                def.damping_mass = alpha[0];
                def.damping_stiffness = beta[0];
                all = swing(&def, NULL, NULL, 0.01, 8);
                off = scene_distance(own, all, mesh.node_count);
                most = largest(all, mesh.node_count);
                if (!CHECK(off < scene_tolerance(1e-8, 1e5) * most && most > 0))
                    printf("  %s, %s, material %d: %g of %g m\n", sb_element_name(types[t]), scheme_names[scheme],
                           material, off, most);
                free(own);
                free(all);
                sb_mesh_free(&mesh);
            }
}

/* Corotated elements, whose loops are others, and hyperelastic ones, whose steps take several iterations, move as
 * linear ones do where little moves. */
static void test_small(void)
{
    const sb_real alpha[2] = {REAL(0.5), 3}, beta[2] = {REAL(0.05), REAL(0.003)};
    const double small = scene_tolerance(1e-5, 2e4); /* times gravity, and what is left between them, about */
    for (int scheme = SB_EULER; scheme <= SB_GENERALISED_ALPHA; scheme++)
        for (int type = SB_TET4; type <= SB_TET10; type += SB_TET10 - SB_TET4)
            for (int kind = 0; kind < 2; kind++) {
                sb_mesh mesh = two_regions((sb_element_type)type, 3, 2, 1);
                sb_body_def def = damped_def(&mesh, (sb_integrator)scheme, sb_material_linear(8000, REAL(0.4), 1000));
                sb_vec3 *linear, *other;
                def.gravity = sb_v3_scale(REAL(small), def.gravity);
                linear = swing(&def, alpha, beta, 0.01, 8);
                def.material = kind ? sb_material_neo_hookean(8000, REAL(0.4), 1000)
                                    : sb_material_corotated(8000, REAL(0.4), 1000);
                other = swing(&def, alpha, beta, 0.01, 8);
                CHECK(scene_distance(linear, other, mesh.node_count) < 10 * small * largest(linear, mesh.node_count));
                free(linear);
                free(other);
                sb_mesh_free(&mesh);
            }
}

/* ---- what it does ---- */

/* The near half damps by its stiffness, or the far one by its mass: all comes to rest. */
static void test_rest(void)
{
    sb_mesh mesh = two_regions(SB_TET4, 6, 2, 2);
    sb_body_def def = damped_def(&mesh, SB_NEWMARK, sb_material_linear(8000, REAL(0.4), 1000));
    const sb_real none[2] = {0, 0}, beta[2] = {REAL(0.05), 0}, alpha[2] = {0, 8};
    double speeds[3];
    for (int k = 0; k < 3; k++) {
        sb_body *body = damped_body(&def, k == 2 ? alpha : none, k == 1 ? beta : none);
        sb_energy energy;
        memset(&energy, 0, sizeof energy);
        speeds[k] = 0;
        for (int i = 0; body && i < 200; i++) {
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
            CHECK_OK(sb_body_energy(body, &energy));
            speeds[k] += i >= 150 ? (double)energy.kinetic : 0;
        }
        sb_body_destroy(body);
    }
    CHECK(speeds[1] < 0.05 * speeds[0] && speeds[2] < 0.05 * speeds[0]);
    sb_mesh_free(&mesh);
}

/* ---- states, recordings, changes, threads ---- */

static const sb_real some_alpha[2] = {REAL(0.5), 3}, some_beta[2] = {REAL(0.05), REAL(0.003)};

static unsigned long long step_on(sb_body *body, int steps)
{
    for (int i = 0; i < steps; i++)
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    return sb_body_state_hash(body);
}

/* A state carries it into a body that has none, and takes it away where it has none itself. */
static void check_saved(const sb_body_def *def)
{
    sb_body *body = damped_body(def, some_alpha, some_beta), *other = damped_body(def, NULL, NULL);
    size_t size = sb_body_state_size(body), plain_size = sb_body_state_size(other);
    void *state = malloc(size), *plain = malloc(plain_size);
    unsigned long long want, bare;
    if (!CHECK(body && other && state && plain))
        return;
    CHECK_OK(sb_body_state_save(other, plain, plain_size));
    bare = step_on(other, 3);
    step_on(body, 3);
    CHECK_OK(sb_body_state_save(body, state, size));
    want = step_on(body, 3);
    CHECK_OK(sb_body_state_load(other, state, size, NULL));
    CHECK(step_on(other, 3) == want);
    CHECK_OK(sb_body_state_load(body, plain, plain_size, NULL));
    CHECK(step_on(body, 3) == bare);
    CHECK_OK(sb_body_state_load(body, state, size, NULL));
    CHECK_OK(sb_body_set_damping(body, 0, 0));
    CHECK_INT((long long)sb_body_state_size(body), (long long)plain_size);
    free(state);
    free(plain);
    sb_body_destroy(body);
    sb_body_destroy(other);
}

static void test_state(void)
{
    for (int scheme = SB_EULER; scheme <= SB_GENERALISED_ALPHA; scheme++)
        for (int slack = 0; slack < 2; slack++) {
            sb_mesh mesh = two_regions(SB_TET4, 4, 2, 2);
            sb_body_def def = damped_def(&mesh, (sb_integrator)scheme, sb_material_corotated(8000, REAL(0.4), 1000));
            def.slack = REAL(0.2) * REAL(slack);
            check_saved(&def);
            sb_mesh_free(&mesh);
        }
}

static void test_recording(void)
{
    sb_mesh mesh = two_regions(SB_TET4, 4, 2, 2);
    sb_body_def def = damped_def(&mesh, SB_NEWMARK, sb_material_corotated(8000, REAL(0.4), 1000));
    sb_body *body = damped_body(&def, NULL, NULL), *fresh = damped_body(&def, NULL, NULL);
    sb_recording *recording = NULL;
    if (CHECK(body && fresh) && CHECK_OK(sb_recording_start(body, 0, NULL, &recording, NULL))) {
        step_on(body, 2);
        CHECK_OK(sb_body_set_region_damping(body, 8, 2, REAL(0.03), NULL));
        step_on(body, 2);
        CHECK_OK(sb_recording_replay(recording, fresh, NULL));
        CHECK(sb_body_state_hash(fresh) == sb_body_state_hash(body));
    }
    sb_recording_destroy(recording);
    sb_body_destroy(body);
    sb_body_destroy(fresh);
    sb_mesh_free(&mesh);
}

/* Cells go, in place or by a new body: the next steps are those of a body that was given its damping afterwards. */
static void check_change(sb_element_type type)
{
    sb_mesh mesh = two_regions(type, 5, 2, 2);
    sb_body_def def = damped_def(&mesh, SB_NEWMARK, sb_material_corotated(8000, REAL(0.4), 1000));
    def.slack = REAL(0.2);
    sb_body *body = damped_body(&def, some_alpha, some_beta), *later = damped_body(&def, NULL, NULL);
    if (!CHECK(body && later))
        return;
    scene_remove_cells(body);
    scene_remove_cells(later);
    CHECK_OK(sb_body_set_region_damping(later, 3, some_alpha[0], some_beta[0], NULL));
    CHECK_OK(sb_body_set_region_damping(later, 8, some_alpha[1], some_beta[1], NULL));
    CHECK(step_on(body, 4) == step_on(later, 4));
    sb_body_destroy(body);
    sb_body_destroy(later);
    sb_mesh_free(&mesh);
}

static void test_change(void)
{
    check_change(SB_TET4);
    check_change(SB_TET10);
}

static void test_threads(void)
{
    for (int scheme = SB_EULER; scheme <= SB_NEWMARK; scheme++) {
        sb_mesh mesh = two_regions(SB_TET4, 8, 4, 4);
        sb_body_def def = damped_def(&mesh, (sb_integrator)scheme, sb_material_corotated(8000, REAL(0.4), 1000));
        unsigned long long hash[2];
        for (int k = 0; k < 2; k++) {
            int workers = 1 + 2 * k;
            sb_body *body;
            def.jobs = scene_jobs(&workers);
            body = damped_body(&def, some_alpha, some_beta);
            hash[k] = body ? step_on(body, 3) : 0;
            sb_body_destroy(body);
        }
        CHECK(hash[0] == hash[1]);
        sb_mesh_free(&mesh);
    }
}

/* ---- refusals ---- */

static void test_refusals(void)
{
    sb_mesh mesh = two_regions(SB_TET4, 3, 1, 1);
    sb_body_def def = damped_def(&mesh, SB_NEWMARK, sb_material_linear(8000, REAL(0.4), 1000));
    scene_memory memory = {0, 0, 0, 0};
    sb_body *body;
    unsigned long long hash;
    def.allocator = scene_allocator(&memory);
    body = damped_body(&def, NULL, NULL);
    if (!CHECK(body != NULL))
        return;
    hash = sb_body_state_hash(body);
    CHECK_RESULT(sb_body_set_region_damping(NULL, 3, 1, 0, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_set_region_damping(body, 3, -1, 0, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_set_region_damping(body, 3, 0, REAL(INFINITY), NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_set_region_damping(body, 4, 1, 0, NULL), SB_ERROR_INDEX);
    memory.fail_at = memory.calls + 1;
    CHECK_RESULT(sb_body_set_region_damping(body, 3, 1, 0, NULL), SB_ERROR_MEMORY);
    CHECK(sb_body_state_hash(body) == hash);
    memory.fail_at = 0;
    CHECK_OK(sb_body_set_region_damping(body, 3, 1, REAL(0.1), NULL));
    memory.fail_from = memory.calls + 1; /* steps allocate nothing */
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    memory.fail_from = 0;
    sb_body_destroy(body);
    CHECK_INT(memory.live, 0);
    def.integrator = SB_CENTRAL_DIFFERENCE;
    body = damped_body(&def, NULL, NULL);
    CHECK_RESULT(sb_body_set_region_damping(body, 3, 1, 0, NULL), SB_ERROR_UNSUPPORTED);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(damping, {"balance", test_balance}, {"regions alike", test_alike}, {"small motion", test_small},
            {"motion comes to rest", test_rest}, {"state", test_state}, {"recording", test_recording},
            {"mesh changes", test_change}, {"same bits for any threads", test_threads}, {"refusals", test_refusals});
