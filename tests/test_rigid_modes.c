/* Modes of bodies with free rigid bodies: weights on bars and beams in closed form, under tension, free in space, on
 * meshes with ties; what modes leave as it was, memory and what is refused. */
#include "check.h"
#include "random_case.h"

/* A bar along x of nu 0 and 10 kg, with a weight on its end. */
typedef struct bar {
    sb_mesh mesh;
    sb_body *body;
    int *nodes, count, id;
} bar;

static int bar_make(bar *t, sb_element_type type, sb_body_def def, double mass, double inertia, int held)
{
    const sb_vec3 size = sb_v3(1, REAL(0.1), REAL(0.1));
    sb_mesh even = scene_box(type, 10, 2, 2, size, 0);
    sb_rigid_def rigid = sb_default_rigid_def();
    memset(t, 0, sizeof *t);
    t->mesh = scene_box(type, 10, 2, 2, size, 0.1);
    t->nodes = (int *)malloc((size_t)even.node_count * sizeof(int));
    for (int i = 0; i < even.node_count && t->nodes; i++)
        if ((double)even.nodes[i].x > 1 - 1e-6)
            t->nodes[t->count++] = i;
    sb_mesh_free(&even);
    def.mesh = &t->mesh;
    t->body = scene_body(&def);
    if (!CHECK(t->body && t->count > 8))
        return 0;
    if (held)
        scene_fix_plane(t->body, &t->mesh, 0, 0, SB_XYZ);
    rigid.mass = REAL(mass);
    rigid.inertia = sb_m3_scale(REAL(inertia), sb_m3_identity());
    rigid.centre = sb_v3(1, REAL(0.05), REAL(0.05));
    rigid.turn = sb_quat_make(2, 1, 0, REAL(0.5));
    rigid.nodes = t->nodes;
    rigid.node_count = t->count;
    return CHECK_OK(sb_body_add_rigid(t->body, &rigid, &t->id, NULL));
}

static void bar_free(bar *t)
{
    sb_body_destroy(t->body);
    sb_mesh_free(&t->mesh);
    free(t->nodes);
}

static sb_body_def elastic(void)
{
    sb_body_def def = sb_default_body_def();
    def.material = sb_material_corotated(REAL(1e5), 0, 1000);
    return def;
}

static int modes_of(sb_body *body, int count, const sb_modes_options *options, double *frequencies, sb_vec3 *shapes)
{
    sb_real found[16];
    sb_error error;
    sb_result result = sb_body_modes(body, count, options, found, shapes, NULL, &error);
    if (result != SB_OK)
        printf("  %s\n", error.message);
    for (int i = 0; i < count && result == SB_OK; i++)
        frequencies[i] = (double)found[i];
    return CHECK_OK(result);
}

static sb_modes_options precise(int at_present)
{
    sb_modes_options options = sb_default_modes_options();
    options.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-3 : 1e-8);
    options.at_present = at_present;
    return options;
}

/* Nodes that hang move as one, to rounding. */
static void check_rigid(const bar *t, const sb_vec3 *shape)
{
    double worst = 0, size = 0;
    for (int i = 1; i < t->count; i++)
        for (int j = 0; j < i; j++) {
            sb_vec3 arm = sb_v3_sub(t->mesh.nodes[t->nodes[i]], t->mesh.nodes[t->nodes[j]]);
            sb_vec3 way = sb_v3_sub(shape[t->nodes[i]], shape[t->nodes[j]]);
            worst = fmax(worst, fabs((double)sb_v3_dot(arm, way)));
            size = fmax(size, (double)sb_v3_norm(shape[t->nodes[i]]));
        }
    CHECK_NEAR(worst, 0, scene_tolerance(1e-12, 64) * (size + 1));
}

/* Of a weight m with the inertia J on a bar: w tan(w L/c) = c rho A/m along it; across it with the beam's mass shared
 * as for slow motions, (K - w^2 M) of the two unknowns of its end; about its axis J w^2 = G Jt/L. Beams that are light
 * beside it, and bars that are not. */
static void test_weight(void)
{
    static const sb_element_type types[] = {SB_HEX20, SB_TET10, SB_HEX27};
    const double bend = 1e5 * 1e-4 / 12, shear = 5.0 / 6 * 0.5e5 * 1e-2;
    const double off = SB_REAL_IS_FLOAT ? 0.01 : 0.003; /* forces of a beam are far smaller than their parts */
    for (int k = 0; k < 3; k++) {
        const double mass = 1000, inertia = 10;
        double f[8], a, b, c, wanted, along = 0.1, compliance[3], det;
        sb_modes_options options = precise(0);
        sb_vec3 *shapes;
        bar t;
        if (!bar_make(&t, types[k], elastic(), mass, inertia, 1))
            return;
        shapes = (sb_vec3 *)malloc(6 * (size_t)t.mesh.node_count * sizeof *shapes);
        if (!modes_of(t.body, 6, &options, f, shapes))
            return;
        for (int i = 0; i < 6; i++)
            check_rigid(&t, shapes + (size_t)i * (size_t)t.mesh.node_count);
        compliance[0] = 1 / (3 * bend) + 1 / shear; /* way and turn by force and moment at the end */
        compliance[1] = 1 / (2 * bend);
        compliance[2] = 1 / bend;
        det = compliance[0] * compliance[2] - compliance[1] * compliance[1];
        a = (mass + 33.0 / 140 * 10) * inertia; /* a w^4 - b w^2 + c = 0 */
        b = ((mass + 33.0 / 140 * 10) * compliance[0] + inertia * compliance[2]) / det;
        c = 1 / det;
        wanted = sqrt((b - sqrt(b * b - 4 * a * c)) / (2 * a)) / 6.283185307179586;
        CHECK_NEAR(f[0], wanted, off * wanted);
        CHECK_NEAR(f[1], wanted, off * wanted);
        CHECK_NEAR(f[2], sqrt(0.5e5 * 0.1406e-4 / inertia) / 6.283185307179586, 0.03 * f[2]); /* its ends do not warp */
        for (int i = 0; i < 60; i++)                                                          /* w L/c */
            along -= (along * tan(along) - 10 / mass) / (tan(along) + along / (cos(along) * cos(along)));
        CHECK_NEAR(f[5], along * 10 / 6.283185307179586, 2e-4 * f[5]);
        free(shapes);
        bar_free(&t);
    }
}

/* A load along the beam, which keeps its direction: the stiffness of its end across is T/(L - tanh(b L)/b), b^2 = T/EI,
 * pulled, and T/(tan(b L)/b - L) pushed. */
static void test_tension(void)
{
    static const double loads[] = {0, 1, -1};
    const double bend = 1e5 * 1e-4 / 12;
    double rest = 1;
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("the balance of a long beam with a heavy end needs double");
        return;
    }
    for (int k = 0; k < 3; k++) {
        double f[2], b = sqrt(fabs(loads[k]) / bend), stiffness = 3 * bend;
        sb_static_options statics = sb_default_static_options();
        sb_modes_options options = precise(1);
        bar t;
        if (!bar_make(&t, SB_HEX20, elastic(), 1000, 1e-3, 1))
            return;
        CHECK_OK(sb_body_set_rigid_load(t.body, t.id, sb_v3(REAL(loads[k]), 0, 0), sb_v3(0, 0, 0)));
        statics.tolerance = REAL(1e-10);
        CHECK_OK(sb_body_solve_static(t.body, &statics, NULL));
        if (!modes_of(t.body, 2, &options, f, NULL))
            return;
        rest = k == 0 ? f[0] : rest;
        stiffness = loads[k] > 0   ? loads[k] / (1 - tanh(b) / b)
                    : loads[k] < 0 ? -loads[k] / (tan(b) / b - 1)
                                   : stiffness;
        CHECK_NEAR(f[0] / rest, sqrt(stiffness / (3 * bend)), 0.005);
        CHECK_NEAR(f[1] / rest, sqrt(stiffness / (3 * bend)), 0.005);
        bar_free(&t);
    }
}

/* Free in space: six of nothing, then what a heavy weight at one end makes of a free bar: along it tan(w L/c) of a bar
 * that is held, nearly. A rigid body without nodes has six of its own; its modes do not move the mesh. */
static void test_free(void)
{
    for (int lone = 0; lone < 2; lone++) {
        double f[13];
        sb_modes_options options = precise(0);
        sb_vec3 *shapes;
        int zeros = lone ? 12 : 6, id;
        bar t;
        if (!bar_make(&t, SB_TET10, elastic(), 1e6, 1e5, 0))
            return;
        if (lone) {
            sb_rigid_def rigid = sb_default_rigid_def();
            rigid.mass = 1;
            rigid.inertia = sb_m3_identity();
            CHECK_OK(sb_body_add_rigid(t.body, &rigid, &id, NULL));
        }
        shapes = (sb_vec3 *)malloc(13 * (size_t)t.mesh.node_count * sizeof *shapes);
        if (!modes_of(t.body, zeros + 1, &options, f, shapes))
            return;
        for (int i = 0; i < zeros; i++)
            CHECK_NEAR(f[i], 0, (SB_REAL_IS_FLOAT ? 0.05 : 1e-4) * f[zeros]);
        CHECK_NEAR(f[zeros], 0.1605, 0.004); /* a light cantilever's, by Timoshenko */
        check_rigid(&t, shapes + (size_t)zeros * (size_t)t.mesh.node_count);
        free(shapes);
        bar_free(&t);
    }
}

/* What modes do leaves the state as it was, gives the same again, and what they need may fail to be there. */
static void test_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_body_def def = elastic();
    sb_result result = SB_ERROR_MEMORY;
    sb_modes_options options = precise(1);
    sb_real f[3], again[3] = {-1, -1, -1};
    int failures = 0;
    uint64_t hash;
    bar t;
    def.allocator = scene_allocator(&memory);
    if (!bar_make(&t, SB_TET4, def, 10, 1, 1))
        return;
    CHECK_OK(sb_body_set_rigid_load(t.body, t.id, sb_v3(0, 0, REAL(0.05)), sb_v3(0, REAL(0.01), 0)));
    CHECK_OK(sb_body_solve_static(t.body, NULL, NULL));
    hash = sb_body_state_hash(t.body);
    CHECK_OK(sb_body_modes(t.body, 3, &options, f, NULL, NULL, NULL));
    CHECK(sb_body_state_hash(t.body) == hash);
    for (int n = 1; result != SB_OK && n < 100; n++) {
        int live = memory.live;
        memory.calls = 0;
        memory.fail_at = n;
        result = sb_body_modes(t.body, 3, &options, again, NULL, NULL, NULL);
        memory.fail_at = 0;
        CHECK_INT(memory.live, live);
        CHECK(sb_body_state_hash(t.body) == hash);
        if (result == SB_OK)
            break;
        failures++;
        CHECK_RESULT(result, SB_ERROR_MEMORY);
        CHECK(again[0] == -1 && again[1] == -1 && again[2] == -1);
    }
    CHECK_OK(result);
    CHECK(failures >= 3);
    CHECK(memcmp(f, again, sizeof f) == 0);
    CHECK_OK(sb_body_step(t.body, REAL(0.01), NULL));
    sb_body_destroy(t.body);
    CHECK_INT(memory.live, 0);
    t.body = NULL;
    bar_free(&t);
}

CHECK_SUITE(rigid_modes, {"a weight on a bar", test_weight}, {"tension", test_tension}, {"free in space", test_free},
            {"memory", test_memory});
