/* Unloading: rest shapes whose loaded shape is the image, on meshes that nobody chose; a closed form; nothing else
 * changes, failures, memory. */
#include <stdlib.h>

#include "softbody.h"

#include "check.h"
#include "gent.h"
#include "random_case.h"
#include "scene.h"

/* What hangs on an imaged body. */
typedef struct burden {
    const sb_mesh *image;
    int *held, held_count;
    int *faces, face_count, corners; /* of the whole surface */
    double pressure;                 /* Pa on it */
    int calls;
} burden;

static sb_result dress(void *user, sb_body *body, sb_real share, sb_error *error)
{
    burden *b = (burden *)user;
    sb_result result = sb_body_hold(body, b->held, b->held_count, SB_XYZ, error);
    b->calls++;
    if (result == SB_OK && b->face_count > 0)
        result =
            sb_body_add_pressure(body, b->faces, b->face_count, b->corners, share * REAL(b->pressure), NULL, error);
    return result;
}

/* Nodes within a share of the way from the low end along x are held, the surface is pressed. */
static void burden_held(burden *b, const sb_mesh *mesh, double share, double pressure)
{
    sb_boundary boundary;
    double low = 1e30, high = -1e30;
    memset(b, 0, sizeof *b);
    b->image = mesh;
    b->held = (int *)malloc((size_t)mesh->node_count * sizeof(int));
    for (int i = 0; i < mesh->node_count; i++) {
        low = fmin(low, (double)mesh->nodes[i].x);
        high = fmax(high, (double)mesh->nodes[i].x);
    }
    for (int i = 0; i < mesh->node_count && CHECK(b->held); i++)
        if ((double)mesh->nodes[i].x < low + share * (high - low))
            b->held[b->held_count++] = i;
    b->pressure = pressure;
    if (pressure != 0 && CHECK_OK(sb_mesh_boundary(mesh, 1, NULL, &boundary, NULL))) {
        int width = sb_mesh_element_width(&boundary.surface);
        b->corners = sb_element_corner_count(boundary.surface.element_type);
        b->face_count = boundary.surface.element_count;
        b->faces = (int *)malloc((size_t)b->face_count * (size_t)b->corners * sizeof(int));
        for (int f = 0; f < b->face_count && CHECK(b->faces); f++)
            for (int k = 0; k < b->corners; k++)
                b->faces[f * b->corners + k] = boundary.nodes[boundary.surface.elements[f * width + k]];
        sb_boundary_free(&boundary);
    }
}

static void burden_of(burden *b, const sb_mesh *mesh, double pressure) { burden_held(b, mesh, 0.15, pressure); }

static void burden_free(burden *b)
{
    free(b->held);
    free(b->faces);
}

/* Loads the rest shape from scratch, as a user would who knows nothing of the image; largest distance to it (m). */
static double reloaded(const sb_unload_def *def, const sb_vec3 *rest)
{
    sb_mesh mesh = *def->body.mesh;
    sb_body_def own = def->body;
    sb_static_options options = def->statics;
    burden *b = (burden *)def->user;
    sb_body *body = NULL;
    double gap = 1e30;
    mesh.nodes = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof *mesh.nodes);
    memcpy(mesh.nodes, rest, (size_t)mesh.node_count * sizeof *mesh.nodes);
    own.mesh = &mesh;
    options.load_steps = 4;
    options.forces_only = 0;
    if (CHECK_OK(sb_body_create(&own, &body, NULL)) && CHECK_OK(dress(b, body, 1, NULL)) &&
        CHECK_OK(sb_body_solve_static(body, &options, NULL)))
        gap = scene_distance(sb_body_positions(body), def->body.mesh->nodes, mesh.node_count);
    sb_body_destroy(body);
    free(mesh.nodes);
    return gap;
}

static sb_unload_def unload_of(const sb_mesh *mesh, sb_material material, sb_vec3 gravity, burden *b)
{
    sb_unload_def def = sb_default_unload_def();
    def.body.mesh = mesh;
    def.body.material = material;
    def.body.gravity = gravity;
    def.dress = dress;
    def.user = b;
    return def;
}

/* Bodies of every element and many materials, as soft as their weight bears: the forward solve from the rest shape is
 * the image within a millionth of its size, and so is the body that the call returns. */
static void test_random(void)
{
    static const sb_element_type types[5] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
    unsigned long long seed = 11;
    double most = 0;
    for (int round = 0; round < check_rounds(check_quick() ? 5 : 10); round++) {
        sb_element_type type = types[round % 5];
        sb_mesh mesh = random_block(&seed, type);
        double young = random_scale(&seed, 2e5, 1e6), nu = check_random_in(&seed, 0.1, 0.42);
        sb_material materials[4];
        burden b;
        sb_unload_def def;
        sb_unload_report report;
        sb_body *body = NULL;
        sb_error error;
        sb_vec3 *rest = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof *rest);
        materials[0] = sb_material_neo_hookean(REAL(young), REAL(nu), 1000);
        materials[1] = sb_material_corotated(REAL(young), REAL(nu), 1000);
        materials[2] = sb_material_neo_hookean_isochoric(REAL(young / 6), REAL(2 / young), 1000);
        materials[3] = sb_material_stable_neo_hookean(REAL(young), REAL(nu), 1000);
        burden_of(&b, &mesh, round % 2 ? check_random_in(&seed, -300, 300) : 0);
        def = unload_of(&mesh, materials[round % 4], sb_v3_scale(REAL(9.81), random_direction(&seed)), &b);
        if (CHECK_OK(sb_body_unload(&def, rest, &body, &report, &error))) {
            double size = (double)report.size;
            CHECK(report.moved > REAL(1e-4) * report.size);
            CHECK((double)report.gap <= (double)def.tolerance * size && report.share == 1);
            CHECK_INT(report.solves, b.calls);
            most = fmax(most, (double)(report.moved / report.size));
            CHECK_NEAR(reloaded(&def, rest) / size, 0, scene_tolerance(1.01e-6, 1000));
            CHECK_NEAR(scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count) / size, 0,
                       scene_tolerance(1.01e-6, 1000));
        }
        sb_body_destroy(body);
        burden_free(&b);
        free(rest);
        sb_mesh_free(&mesh);
    }
    CHECK(check_rounds(10) < 10 || check_quick() || most > 0.05); /* some move far */
}

/* A column of St. Venant-Kirchhoff, nu 0, drawn to length l by a dead force T per area at rest: E l (l^2 - 1)/2 = T, so
 * that its rest shape is the image shortened by l; strains of a half, on shaken meshes. */
typedef struct pulled {
    const sb_mesh *image;
    double traction;
    int *faces, face_count, corners;
} pulled;

static sb_result draw(void *user, sb_body *body, sb_real share, sb_error *error)
{
    const pulled *p = (const pulled *)user;
    sb_result result = SB_OK;
    for (int axis = 0; axis < 3; axis++)
        for (int i = 0; i < p->image->node_count && result == SB_OK; i++)
            if (fabs((double)scene_component(p->image->nodes[i], axis)) < 1e-9)
                result = sb_body_hold(body, &i, 1, 1 << axis, error);
    if (result == SB_OK)
        result = sb_body_add_traction(body, p->faces, p->face_count, p->corners, sb_v3(share * REAL(p->traction), 0, 0),
                                      error);
    return result;
}

static void test_column(void)
{
    static const sb_element_type types[3] = {SB_TET4, SB_HEX8, SB_TET10};
    static const double stretches[3] = {0.85, 1.2, 1.6};
    for (int t = 0; t < 3; t++) {
        sb_mesh mesh = scene_box(types[t], 4, 2, 2, sb_v3(REAL(0.4), REAL(0.1), REAL(0.1)), 0.15);
        double l = stretches[t], young = 5000;
        sb_boundary boundary;
        pulled p = {&mesh, young * l * (l * l - 1) / 2, NULL, 0, 0};
        sb_unload_def def = sb_default_unload_def();
        sb_unload_report report;
        sb_error error;
        sb_vec3 *rest = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof *rest);
        double worst = 0;
        if (CHECK_OK(sb_mesh_boundary(&mesh, 1, NULL, &boundary, NULL))) {
            int width = sb_mesh_element_width(&boundary.surface);
            p.corners = sb_element_corner_count(boundary.surface.element_type);
            p.faces = (int *)malloc((size_t)boundary.surface.element_count * 4 * sizeof(int));
            for (int f = 0; f < boundary.surface.element_count; f++) {
                int at_end = 1;
                for (int k = 0; k < p.corners; k++) {
                    int node = boundary.nodes[boundary.surface.elements[f * width + k]];
                    p.faces[p.face_count * p.corners + k] = node;
                    at_end = at_end && (double)mesh.nodes[node].x > 0.3999;
                }
                p.face_count += at_end;
            }
            sb_boundary_free(&boundary);
        }
        def.body.mesh = &mesh;
        def.body.material = sb_material_svk(REAL(young), 0, 1000);
        def.dress = draw;
        def.user = &p;
        def.tolerance = REAL(scene_tolerance(1e-9, 1000));
        CHECK_OK(sb_body_unload(&def, rest, NULL, &report, &error));
        for (int i = 0; i < mesh.node_count; i++) {
            sb_vec3 x = mesh.nodes[i];
            worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(rest[i], sb_v3(x.x / REAL(l), x.y, x.z))));
        }
        CHECK_NEAR(worst / (double)report.size, 0, scene_tolerance(1e-8, 3000));
        free(p.faces);
        free(rest);
        sb_mesh_free(&mesh);
    }
}

/* A slender column stands on its foot, 0.3 m high; Greenhill's height for this square, (7.837 E I/(rho g A))^(1/3), is
 * 0.49 m at the first modulus and 0.14 m at the second: none is found, or one that sb_body_modes refuses. */
static void test_buckling(void)
{
    static const double youngs[2] = {2e6, 5e4};
    sb_mesh mesh = scene_box(SB_TET10, 6, 1, 1, sb_v3(REAL(0.3), REAL(0.03), REAL(0.03)), 0.02);
    sb_vec3 *rest = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof *rest);
    for (int k = 0; k < 2; k++) {
        burden b;
        sb_unload_def def;
        sb_unload_report report;
        sb_modes_options modes = sb_default_modes_options();
        sb_body *body = NULL;
        sb_real frequency;
        sb_result found;
        sb_error error;
        modes.at_present = 1;
        modes.tolerance = REAL(1e-2);
        burden_of(&b, &mesh, 0);
        b.held_count = 0;
        for (int i = 0; i < mesh.node_count; i++)
            if (mesh.nodes[i].x < REAL(1e-9))
                b.held[b.held_count++] = i;
        def = unload_of(&mesh, sb_material_svk(REAL(youngs[k]), 0, 1000), sb_v3(REAL(-9.81), 0, 0), &b);
        def.max_iterations = k ? 4 : 12;
        def.statics.max_newton = k ? 3 : 20;
        found = sb_body_unload(&def, rest, &body, &report, &error);
        CHECK(k > 0 || found == SB_OK);
        if (found == SB_OK) /* straight it is in balance, but not for long */
            CHECK_RESULT(sb_body_modes(body, 1, &modes, &frequency, NULL, NULL, NULL), k ? SB_ERROR_INDEFINITE : SB_OK);
        sb_body_destroy(body);
        burden_free(&b);
    }
    free(rest);
    sb_mesh_free(&mesh);
}

/* Organs as soft as livers and muscles, hung from a random side, of what remembers its past, too: relaxed, or as after
 * a sudden load. */
static void test_soft(void)
{
    const sb_real g[2] = {REAL(0.4), REAL(0.3)}, tau[2] = {REAL(0.3), 5};
    unsigned long long seed = 23;
    for (int round = 0; round < check_rounds(check_quick() ? 4 : 12); round++) {
        sb_mesh mesh;
        sb_vec3 low, high;
        double young = random_scale(&seed, 2e4, 1e5), nu = check_random_in(&seed, 0.2, 0.45);
        sb_vec3 *rest;
        burden b;
        sb_unload_def def;
        sb_unload_report report;
        sb_body *body = NULL;
        sb_error error;
        if (!CHECK_OK(random_blob_mesh(&seed, round % 2 ? SB_TET10 : SB_TET4, &mesh)))
            return;
        sb_mesh_bounds(&mesh, &low, &high);
        for (int i = 0; i < mesh.node_count; i++)
            mesh.nodes[i] = sb_v3_scale(REAL(0.15) / (high.x - low.x), mesh.nodes[i]);
        rest = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof *rest);
        burden_held(&b, &mesh, 0.3, 0);
        def = unload_of(&mesh, sb_material_neo_hookean(REAL(young), REAL(nu), 1060),
                        sb_v3_scale(REAL(9.81), random_direction(&seed)), &b);
        if (round % 3)
            def.body.material = sb_material_with_prony(def.body.material, g, tau, 2);
        def.statics.instantaneous = round % 3 == 1;
        if (CHECK_OK(sb_body_unload(&def, rest, &body, &report, &error)) && CHECK(rest)) {
            CHECK_NEAR(reloaded(&def, rest) / (double)report.size, 0, scene_tolerance(1.01e-6, 1000));
            CHECK_NEAR(scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count) / (double)report.size, 0,
                       scene_tolerance(1.01e-6, 1000));
        }
        sb_body_destroy(body);
        burden_free(&b);
        free(rest);
        sb_mesh_free(&mesh);
    }
}

/* The same bits for any number of threads, in place of the image as well as beside it; of a law of the caller's own. */
static void test_threads(void)
{
    gent g = {REAL(3e4), 2, REAL(1e5)};
    sb_material_law law = gent_law(&g);
    sb_mesh mesh = scene_box(SB_TET10, 4, 2, 2, sb_v3(REAL(0.24), REAL(0.1), REAL(0.1)), 0.1);
    size_t bytes = (size_t)mesh.node_count * sizeof(sb_vec3);
    sb_vec3 *first = (sb_vec3 *)malloc(bytes), *rest = (sb_vec3 *)malloc(bytes);
    for (int workers = 1; workers <= 5; workers += 2) {
        burden b;
        sb_unload_def def;
        burden_of(&b, &mesh, 200);
        def = unload_of(&mesh, sb_material_custom(&law, 0, 1000), sb_v3(0, 1, REAL(-9.81)), &b);
        def.body.jobs = scene_jobs(&workers);
        CHECK_OK(sb_body_unload(&def, workers == 5 ? mesh.nodes : rest, NULL, NULL, NULL));
        CHECK(workers == 1 || memcmp(first, workers == 5 ? mesh.nodes : rest, bytes) == 0);
        if (workers == 1)
            memcpy(first, rest, bytes);
        burden_free(&b);
    }
    free(first);
    free(rest);
    sb_mesh_free(&mesh);
}

/* What dress returns ends the call, and is said where it says nothing; what is absurd is refused before the search; a
 * trial's inverted elements are not taken for the caller's. */
static sb_result refuse(void *user, sb_body *body, sb_real share, sb_error *error)
{
    burden *b = (burden *)user;
    return b->calls == 2 ? SB_ERROR_MESH : dress(user, body, share, error);
}

static void test_named(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 3, 1, 1, sb_v3(REAL(0.3), REAL(0.1), REAL(0.1)), 0.1);
    sb_vec3 *rest = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof *rest);
    burden b;
    sb_unload_def def, plain;
    sb_unload_report report;
    sb_error error;
    int first = mesh.elements[0];
    burden_of(&b, &mesh, 0);
    def = plain = unload_of(&mesh, sb_material_neo_hookean(40000, REAL(0.3), 1000), sb_v3(0, 0, REAL(-9.81)), &b);
    plain.dress = refuse;
    CHECK_RESULT(sb_body_unload(&plain, rest, NULL, &report, &error), SB_ERROR_MESH);
    CHECK(strstr(error.message, "dress") != NULL);
    CHECK_RESULT(error.result, SB_ERROR_MESH);
    CHECK_RESULT(report.error.result, SB_ERROR_MESH);
    CHECK_INT(report.solves, 2);
    plain = def;
    plain.statics.tolerance = 2;
    CHECK_RESULT(sb_body_unload(&plain, rest, NULL, &report, &error), SB_ERROR_ARGUMENT);
    CHECK_INT(report.solves, 0);
    plain = def;
    plain.body.gravity = sb_v3(0, 0, REAL(-1e20));
    CHECK_RESULT(sb_body_unload(&plain, rest, NULL, &report, &error), SB_ERROR_INVERTED);
    CHECK(strstr(error.message, "no rest shape found") != NULL);
    mesh.elements[0] = mesh.elements[1];
    mesh.elements[1] = first;
    CHECK_RESULT(sb_body_unload(&def, rest, NULL, &report, &error), SB_ERROR_MESH);
    CHECK_INT(report.solves, 0);
    burden_free(&b);
    free(rest);
    sb_mesh_free(&mesh);
}

/* Errors by name with nothing written; every allocation fails in turn. */
static void test_failures(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 3, 1, 1, sb_v3(REAL(0.3), REAL(0.1), REAL(0.1)), 0.1);
    scene_memory memory = {0, 0, 0, 0};
    burden b;
    sb_unload_def def, plain = sb_default_unload_def();
    sb_unload_report report;
    sb_error error;
    sb_body *body = NULL;
    sb_vec3 *rest = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof *rest);
    burden_of(&b, &mesh, 10);
    def = unload_of(&mesh, sb_material_neo_hookean(20000, REAL(0.3), 1000), sb_v3(0, 0, REAL(-9.81)), &b);
    CHECK_RESULT(sb_body_unload(NULL, rest, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_unload(&def, NULL, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_unload(&plain, rest, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    plain = def;
    plain.dress = NULL; /* nothing holds it */
    CHECK_RESULT(sb_body_unload(&plain, rest, &body, &report, &error), SB_ERROR_UNCONSTRAINED);
    plain = def;
    plain.max_iterations = 1;
    CHECK_RESULT(sb_body_unload(&plain, rest, &body, &report, &error), SB_ERROR_NOT_CONVERGED);
    CHECK(report.gap > 0 && report.share == 0 && strstr(report.error.message, "gap") != NULL);
    plain = def;
    plain.body.gravity = sb_v3(0, 0, REAL(-1e5)); /* a pudding */
    CHECK(sb_body_unload(&plain, rest, &body, &report, &error) != SB_OK);
    CHECK(report.share < 1 && error.message[0]);
    for (int i = 0; i < mesh.node_count; i++)
        CHECK(!body && rest[i].x == 0 && rest[i].y == 0 && rest[i].z == 0);
    def.body.allocator = scene_allocator(&memory);
    def.statics.tolerance = REAL(1e-6);
    def.tolerance = REAL(1e-2);
    for (int n = 1;; n += 1 + n / 16) {
        memory.calls = 0;
        memory.fail_at = n;
        if (sb_body_unload(&def, rest, &body, NULL, &error) == SB_OK)
            break;
        CHECK_RESULT(error.result, SB_ERROR_MEMORY);
        CHECK(!body && memory.live == 0);
    }
    sb_body_destroy(body);
    CHECK_INT(memory.live, 0);
    burden_free(&b);
    free(rest);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(unload, {"random bodies return to the image", test_random}, {"column", test_column},
            {"buckling is reported", test_buckling}, {"soft organs", test_soft}, {"threads", test_threads},
            {"what is wrong is named", test_named}, {"failures", test_failures});
