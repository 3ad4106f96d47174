/* Tests of saved states: what follows a load is what followed the save, and nothing else gets in. */
#include "softbody.h"

#include "check.h"
#include "image.h"
#include "scene.h"

/* ---- a scene that uses everything a body has ---- */

typedef struct variant {
    const char *name;
    sb_element_type type;
    int single_rotation;
    sb_integrator integrator;
    sb_material_model model;
    sb_mass_kind mass;
    int max_newton;
} variant;

/* One row per element, integrator and kind of step. */
static const variant variants[] = {
    {"tet4 batched", SB_TET4, 0, SB_EULER, SB_COROTATED, SB_MASS_LUMPED, SB_AUTO},
    {"tet4 batched, iterated", SB_TET4, 0, SB_EULER, SB_COROTATED, SB_MASS_LUMPED, 4},
    {"tet4 batched Newmark", SB_TET4, 0, SB_NEWMARK, SB_COROTATED, SB_MASS_CONSISTENT, SB_AUTO},
    {"tet4 neo-Hookean, linearised", SB_TET4, 0, SB_EULER, SB_NEO_HOOKEAN, SB_MASS_LUMPED, 1},
    {"tet10", SB_TET10, 0, SB_EULER, SB_COROTATED, SB_MASS_LUMPED, SB_AUTO},
    {"tet10 Newmark", SB_TET10, 0, SB_NEWMARK, SB_STABLE_NEO_HOOKEAN, SB_MASS_LUMPED, 4},
    {"tet10 single rotation", SB_TET10, 1, SB_EULER, SB_COROTATED, SB_MASS_LUMPED, SB_AUTO},
    {"tet10 single rotation Newmark", SB_TET10, 1, SB_NEWMARK, SB_COROTATED, SB_MASS_REDUCED, SB_AUTO},
    {"hex8", SB_HEX8, 0, SB_EULER, SB_COROTATED, SB_MASS_LUMPED, SB_AUTO},
    {"hex8 linear Newmark", SB_HEX8, 0, SB_NEWMARK, SB_LINEAR, SB_MASS_CONSISTENT, SB_AUTO},
    {"hex8 neo-Hookean", SB_HEX8, 0, SB_EULER, SB_NEO_HOOKEAN, SB_MASS_LUMPED, SB_AUTO},
};
enum { VARIANTS = sizeof variants / sizeof variants[0] };

static sb_material make_material(sb_material_model model, double young)
{
    sb_material material = sb_material_corotated(REAL(young), REAL(0.4), REAL(1000));
    material.model = model;
    return material;
}

static sb_mesh make_mesh(sb_element_type type)
{
    sb_mesh mesh = scene_box(type, type == SB_TET10 ? 2 : 4, 1, 1, sb_v3(REAL(0.1), REAL(0.05), REAL(0.05)), 0);
    mesh.regions = (int *)calloc((size_t)mesh.element_count, sizeof(int));
    for (int e = 0; mesh.regions && e < mesh.element_count; e++)
        mesh.regions[e] = 2 * e < mesh.element_count ? 3 : -5;
    return mesh;
}

static sb_body *make_body(const variant *v, const sb_mesh *mesh, sb_allocator allocator)
{
    sb_region_material stiffer;
    sb_body_def def = sb_default_body_def();
    stiffer.region = -5;
    stiffer.material = make_material(v->model, 4e4);
    def.mesh = mesh;
    def.material = make_material(v->model, 2e4);
    def.region_materials = &stiffer;
    def.region_material_count = 1;
    def.single_rotation = v->single_rotation;
    def.integrator = v->integrator;
    def.mass = v->mass;
    def.max_newton = v->max_newton;
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.damping_stiffness = REAL(0.01);
    def.allocator = allocator;
    return scene_body(&def);
}

static sb_body *make_plain_body(const variant *v, const sb_mesh *mesh)
{
    sb_allocator none;
    memset(&none, 0, sizeof none);
    return make_body(v, mesh, none);
}

/* One frame of the scene: a tool at the far end, and now and then something of everything else. */
static void play_frame(sb_body *body, const variant *v, const sb_mesh *mesh, int frame)
{
    int tool = mesh->node_count - 1, other = mesh->node_count / 2;
    sb_vec3 pull = sb_v3(0, REAL(0.0003) * REAL(frame % 20), REAL(-0.0004) * REAL(frame % 20));
    sb_vec3 push = sb_v3(REAL(0.02), 0, REAL(0.01) * REAL(frame % 5));
    sb_vec3 far_away = sb_v3(REAL(-10), 0, 0);
    sb_material softer = make_material(v->model, 1e4 + 100 * frame);
    if (frame == 0)
        scene_fix_plane(body, mesh, 0, 0, SB_XYZ);
    if (frame % 20 < 15) {
        CHECK_OK(sb_body_prescribe(body, &tool, 1, SB_Y | SB_Z, &pull, 1));
    } else {
        CHECK_OK(sb_body_release_nodes(body, &tool, 1, SB_XYZ));
    }
    if (frame % 10 == 3)
        CHECK_OK(sb_body_add_forces(body, &other, 1, &push, 1));
    if (frame % 10 == 8)
        sb_body_clear_loads(body);
    if (frame % 17 == 5)
        CHECK_OK(sb_body_set_region_material(body, 3, &softer, NULL));
    if (frame % 31 == 30)
        CHECK_OK(sb_body_fix_nodes(body, &other, 1, SB_X));
    if (frame % 31 == 7)
        CHECK_OK(sb_body_release_nodes(body, &other, 1, SB_XYZ));
    if (frame % 23 == 11) { /* more than a body can follow, or not: both must repeat */
        sb_body_prescribe(body, &tool, 1, SB_XYZ, &far_away, 1);
        sb_body_step(body, REAL(0.01), NULL);
        CHECK_OK(sb_body_release_nodes(body, &tool, 1, SB_XYZ));
    }
    if (frame % 41 == 35 && v->max_newton != 4 && !(v->single_rotation && v->integrator == SB_NEWMARK))
        sb_body_solve_static(body, NULL, NULL);
    if (frame == 40)
        sb_body_set_damping(body, REAL(0.1), REAL(0.02));
    sb_body_step(body, frame % 2 ? REAL(0.01) : REAL(0.008), NULL);
}

static void play(sb_body *body, const variant *v, const sb_mesh *mesh, int from, int to)
{
    for (int frame = from; frame < to; frame++)
        play_frame(body, v, mesh, frame);
}

/* What a user sees of a body: positions, velocities, reactions. */
static unsigned long long visible_hash(const sb_body *body)
{
    size_t bytes = (size_t)sb_body_node_count(body) * sizeof(sb_vec3);
    return scene_hash(sb_body_positions(body), bytes) ^ 3 * scene_hash(sb_body_velocities(body), bytes) ^
           5 * scene_hash(sb_body_reactions(body), bytes) ^ 7 * scene_hash(sb_body_external_forces(body), bytes);
}

static unsigned char *save_state(const sb_body *body, size_t *size)
{
    unsigned char *state;
    *size = sb_body_state_size(body);
    state = (unsigned char *)malloc(*size ? *size : 1);
    CHECK(*size > 0);
    CHECK_OK(sb_body_state_save(body, state, *size));
    return state;
}

/* ---- continuing ---- */

static void check_variant(const variant *v)
{
    enum { HALF = 29, END = 50 };
    sb_mesh mesh = make_mesh(v->type);
    sb_body *a = make_plain_body(v, &mesh), *fresh = make_plain_body(v, &mesh), *again = make_plain_body(v, &mesh);
    unsigned char *state;
    unsigned long long end, middle;
    uint64_t full_end;
    size_t size;
    if (!CHECK(a && fresh && again))
        return;
    play(a, v, &mesh, 0, HALF);
    state = save_state(a, &size);
    middle = visible_hash(a);
    play(a, v, &mesh, HALF, END);
    end = visible_hash(a);
    full_end = sb_body_state_hash(a);
    CHECK(scene_all_finite(sb_body_positions(a), mesh.node_count));
    CHECK(end != middle);

    play(again, v, &mesh, 0, END); /* the save itself left no trace */
    if (!CHECK(visible_hash(again) == end && sb_body_state_hash(again) == full_end))
        printf("  %s: saving changed the run\n", v->name);

    CHECK_OK(sb_body_state_load(fresh, state, size, NULL));
    CHECK(visible_hash(fresh) == middle);
    play(fresh, v, &mesh, HALF, END);
    if (!CHECK(visible_hash(fresh) == end && sb_body_state_hash(fresh) == full_end))
        printf("  %s: a fresh body goes on differently\n", v->name);

    CHECK_OK(sb_body_state_load(a, state, size, NULL)); /* after quite another past */
    play(a, v, &mesh, HALF, END);
    if (!CHECK(visible_hash(a) == end && sb_body_state_hash(a) == full_end))
        printf("  %s: the same body goes on differently\n", v->name);
    free(state);
    sb_body_destroy(a);
    sb_body_destroy(fresh);
    sb_body_destroy(again);
    sb_mesh_free(&mesh);
}

static void test_continue(void)
{
    for (int i = 0; i < VARIANTS; i++)
        check_variant(variants + i);
}

/* Saved at every moment of the scene, loaded in turn into one body: the next frame is the same. */
static void test_every_moment(void)
{
    for (int i = 0; i < VARIANTS; i += 2) {
        const variant *v = variants + i;
        sb_mesh mesh = make_mesh(v->type);
        sb_body *a = make_plain_body(v, &mesh), *b = make_plain_body(v, &mesh);
        for (int frame = 0; a && b && frame < 38; frame++) {
            size_t size;
            unsigned char *state = save_state(a, &size);
            CHECK_OK(sb_body_state_load(b, state, size, NULL));
            CHECK(sb_body_state_hash(b) == sb_body_state_hash(a));
            free(state);
            play_frame(a, v, &mesh, frame);
            play_frame(b, v, &mesh, frame);
            if (!CHECK(sb_body_state_hash(b) == sb_body_state_hash(a))) {
                printf("  %s, frame %d\n", v->name, frame);
                break;
            }
        }
        sb_body_destroy(a);
        sb_body_destroy(b);
        sb_mesh_free(&mesh);
    }
}

/* A material of another kind turns the batched loops off and on; their warm starts come along. */
static void test_material_switch(void)
{
    const variant *v = variants + 0;
    sb_mesh mesh = make_mesh(v->type);
    sb_body *a = make_plain_body(v, &mesh), *b = make_plain_body(v, &mesh);
    sb_material hyper = make_material(SB_STABLE_NEO_HOOKEAN, 1e4), back = make_material(SB_COROTATED, 1e4);
    if (CHECK(a && b)) {
        size_t size;
        unsigned char *state;
        play(a, v, &mesh, 0, 12);
        CHECK_OK(sb_body_set_region_material(a, 3, &hyper, NULL));
        play(a, v, &mesh, 12, 14);
        state = save_state(a, &size);
        CHECK_OK(sb_body_state_load(b, state, size, NULL));
        for (int k = 0; k < 2; k++) {
            sb_body *body = k ? a : b;
            sb_energy energy;
            CHECK_OK(sb_body_energy(body, &energy));
            sb_body_step(body, REAL(0.01), NULL);
            CHECK_OK(sb_body_set_material(body, &back, NULL));
            for (int i = 0; i < 5; i++)
                CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        }
        CHECK(sb_body_state_hash(a) == sb_body_state_hash(b));
        free(state);
    }
    sb_body_destroy(a);
    sb_body_destroy(b);
    sb_mesh_free(&mesh);
}

/* Static solves raise their loads from those of the last one, which a state remembers. */
static void test_static_goes_on(void)
{
    const variant *v = variants + 3;
    sb_mesh mesh = make_mesh(v->type);
    sb_body *a = make_plain_body(v, &mesh), *b = make_plain_body(v, &mesh);
    sb_static_options options = sb_default_static_options();
    int tool = mesh.node_count - 1;
    sb_vec3 push = sb_v3(0, 0, REAL(0.5));
    if (CHECK(a && b)) {
        unsigned char *state;
        size_t size;
        options.load_steps = 3;
        scene_fix_plane(a, &mesh, 0, 0, SB_XYZ);
        CHECK_OK(sb_body_solve_static(a, &options, NULL));
        CHECK_OK(sb_body_add_forces(a, &tool, 1, &push, 1));
        state = save_state(a, &size);
        CHECK_OK(sb_body_state_load(b, state, size, NULL));
        CHECK_OK(sb_body_solve_static(a, &options, NULL));
        CHECK_OK(sb_body_solve_static(b, &options, NULL));
        CHECK(visible_hash(a) == visible_hash(b) && sb_body_state_hash(a) == sb_body_state_hash(b));
        free(state);
    }
    sb_body_destroy(a);
    sb_body_destroy(b);
    sb_mesh_free(&mesh);
}

/* A failing step or static solve leaves the whole state as it was, warm starts and preconditioner included. */
static void test_failures_leave_no_trace(void)
{
    check_bad_numbers();
    for (int i = 0; i < VARIANTS; i++) {
        const variant *v = variants + i;
        sb_mesh mesh = make_mesh(v->type);
        sb_body *body = make_plain_body(v, &mesh);
        int tool = mesh.node_count - 1, failed = 0;
        if (!CHECK(body != NULL))
            continue;
        play(body, v, &mesh, 0, 10);
        for (int k = 0; k < 3; k++) {
            sb_vec3 force = sb_v3(SB_REAL_MAX / 8, 0, 0);
            uint64_t before;
            sb_result result;
            CHECK_OK(sb_body_add_forces(body, &tool, 1, &force, 1));
            before = sb_body_state_hash(body);
            result = k == 1 ? sb_body_solve_static(body, NULL, NULL) : sb_body_step(body, REAL(0.01), NULL);
            failed += result != SB_OK;
            if (result != SB_OK && !CHECK(sb_body_state_hash(body) == before))
                printf("  %s, %s\n", v->name, k == 1 ? "static" : "step");
            sb_body_clear_loads(body);
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        }
        if (!CHECK(failed == 3))
            printf("  %s: %d of 3 failed\n", v->name, failed);
        if (v->model == SB_NEO_HOOKEAN) { /* fails late, after linear solves */
            sb_vec3 inside_out = sb_v3(REAL(-10), 0, 0);
            uint64_t before;
            CHECK_OK(sb_body_prescribe(body, &tool, 1, SB_XYZ, &inside_out, 1));
            before = sb_body_state_hash(body);
            CHECK(sb_body_step(body, REAL(0.01), NULL) != SB_OK);
            CHECK(sb_body_state_hash(body) == before);
        }
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* ---- what is refused ---- */

/* A refused load: the code, a message, and the body as it was. */
static void check_refused(sb_body *body, const unsigned char *state, size_t size, sb_result expected, const char *part)
{
    sb_error error;
    uint64_t before = sb_body_state_hash(body);
    memset(&error, 0, sizeof error);
    CHECK_RESULT(sb_body_state_load(body, state, size, &error), expected);
    CHECK_INT(error.result, expected);
    if (!CHECK(strstr(error.message, part) != NULL))
        printf("  message: %s\n", error.message);
    CHECK(sb_body_state_hash(body) == before);
    CHECK_RESULT(sb_body_state_load(body, state, size, NULL), expected);
}

static void test_damage(void)
{
    const variant *v = variants + 4;
    sb_mesh mesh = make_mesh(v->type);
    sb_body *body = make_plain_body(v, &mesh);
    unsigned char *state, *bad;
    size_t size;
    if (!CHECK(body != NULL))
        return;
    play(body, v, &mesh, 0, 5);
    state = save_state(body, &size);
    bad = (unsigned char *)malloc(size + 8);
    for (size_t cut = 0; cut < size; cut += cut < 64 ? 1 : 97)
        check_refused(body, state, cut, SB_ERROR_FORMAT, cut < 32 ? "too few" : "shorter");
    memcpy(bad, state, size);
    memset(bad + size, 0, 8);
    check_refused(body, bad, size + 8, SB_ERROR_FORMAT, "longer");
    for (size_t at = 0; at < size; at += at < 40 ? 1 : 61) { /* every bit of the head, and many behind it */
        memcpy(bad, state, size);
        bad[at] ^= (unsigned char)(1u << at % 8);
        if (at < 8)
            check_refused(body, bad, size, SB_ERROR_FORMAT, "not the bytes");
        else if (at < 12)
            check_refused(body, bad, size, SB_ERROR_UNSUPPORTED, "version");
        else if (at < 16)
            check_refused(body, bad, size, SB_ERROR_FORMAT, "reals");
        else if (at < 24)
            check_refused(body, bad, size, SB_ERROR_FORMAT, "than the size");
        else
            check_refused(body, bad, size, SB_ERROR_FORMAT, "checksum");
    }
    memcpy(bad, state, size);
    bad[12] = (unsigned char)(12 - (int)sizeof(sb_real));
    check_refused(body, bad, size, SB_ERROR_UNSUPPORTED, "reals of");
    CHECK_OK(sb_body_state_load(body, state, size, NULL));
    free(state);
    free(bad);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* Values that no body can have, with a checksum that is right. */
static void test_forged_values(void)
{
    enum { NUMBER_COUNT = 10 };
    const double most = (double)SB_REAL_MAX;
    check_bad_numbers();
    struct forged {
        double from, to;
        sb_result expected;
        const char *part;
    } numbers[NUMBER_COUNT] = {
        {0.375, 10 * most, SB_ERROR_NOT_FINITE, "displacement of node 3"},
        {0.4375, 10 * most, SB_ERROR_NOT_FINITE, "velocity of node 4"},
        {0.46875, -10 * most, SB_ERROR_NOT_FINITE, "target of node 5"},
        {-9.75, 10 * most, SB_ERROR_NOT_FINITE, "gravity"},
        {0.0078125, -1, SB_ERROR_ARGUMENT, "damping"},
        {0.001953125, 1, SB_ERROR_ARGUMENT, "tolerance"},
        {1025, -5, SB_ERROR_MATERIAL, "density"},
        {1025, 10 * most, SB_ERROR_NOT_FINITE, "density"},
        {0.375, 0.40625, SB_OK, ""},
        {1025, 900, SB_OK, ""},
    };
    const variant *v = variants + 0;
    sb_mesh mesh = make_mesh(v->type);
    sb_body *body = make_plain_body(v, &mesh);
    sb_vec3 *values = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof *values), target = {0, 0, REAL(0.46875)};
    sb_material material = make_material(SB_COROTATED, 2e4);
    int node = 5;
    unsigned char *state, *bad;
    size_t size;
    if (!CHECK(body && values))
        return;
    material.density = 1025;
    values[3].y = REAL(0.375);
    CHECK_OK(sb_body_set_displacements(body, values));
    values[3].y = 0;
    values[4].x = REAL(0.4375);
    CHECK_OK(sb_body_set_velocities(body, values));
    CHECK_OK(sb_body_prescribe(body, &node, 1, SB_Z, &target, 1));
    CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, REAL(-9.75))));
    CHECK_OK(sb_body_set_damping(body, REAL(0.0078125), 0));
    CHECK_OK(sb_body_set_solver(body, REAL(0.001953125), 321));
    CHECK_OK(sb_body_set_material(body, &material, NULL));
    state = save_state(body, &size);
    bad = (unsigned char *)malloc(size + 8);
    for (int i = 0; i < NUMBER_COUNT; i++) {
        size_t at = image_find_real(state, size, 24, REAL(numbers[i].from));
        memcpy(bad, state, size);
        image_put_real(bad + at, REAL(numbers[i].to));
        image_seal(bad, size);
        if (numbers[i].expected == SB_OK)
            CHECK_OK(sb_body_state_load(body, bad, size, NULL));
        else
            check_refused(body, bad, size, numbers[i].expected, numbers[i].part);
    }
    memset(bad, 0, size + 8); /* bytes that no part takes */
    memcpy(bad, state, size);
    image_seal(bad, size + 8);
    check_refused(body, bad, size + 8, SB_ERROR_FORMAT, "too many");
    memcpy(bad, state, size - 16);
    image_seal(bad, size - 16);
    check_refused(body, bad, size - 16, SB_ERROR_FORMAT, "too early");
    free(bad);
    free(state);
    free(values);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* Any byte changed, with a right checksum: the load is refused without a trace, or the body can go on. */
static void test_forged_bytes(void)
{
    check_bad_numbers();
    for (int i = 0; i < VARIANTS; i += 3) {
        const variant *v = variants + i;
        sb_mesh mesh = make_mesh(v->type);
        sb_body *body = make_plain_body(v, &mesh);
        unsigned char *state, *bad;
        size_t size;
        int accepted = 0, refused = 0;
        if (!CHECK(body != NULL))
            continue;
        play(body, v, &mesh, 0, 4);
        state = save_state(body, &size);
        bad = (unsigned char *)malloc(size);
        for (size_t at = 24; at < size - 8; at += at < 300 ? 1 : 331) {
            sb_error error;
            uint64_t before = sb_body_state_hash(body);
            memcpy(bad, state, size);
            bad[at] = (unsigned char)(bad[at] ^ (at & 1 ? 0xFF : 0x40));
            image_seal(bad, size);
            if (sb_body_state_load(body, bad, size, &error) != SB_OK) {
                CHECK(sb_body_state_hash(body) == before && error.message[0]);
                refused++;
                continue;
            }
            accepted++;
            CHECK_OK(sb_body_set_solver(body, REAL(1e-3), 20)); /* the settings may ask for endless work */
            sb_body_step(body, REAL(0.01), NULL);
            CHECK(scene_all_finite(sb_body_positions(body), mesh.node_count));
            CHECK(scene_all_finite(sb_body_velocities(body), mesh.node_count));
        }
        CHECK(refused > 50 && accepted > 10);
        CHECK_OK(sb_body_state_load(body, state, size, NULL));
        free(bad);
        free(state);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* Changes part of a mesh or def; the state of the first body is then refused by the second. */
static void test_other_bodies(void)
{
    static const char *const parts[] = {"nodes",   "mesh",   "single_rotation", "kind of mass",
                                        "regions", "points", "preconditioner"};
    const variant *v = variants + 4;
    sb_mesh mesh = make_mesh(v->type), longer = scene_box(SB_TET10, 5, 1, 1, sb_v3(1, 1, 1), 0);
    sb_body *body = make_plain_body(v, &mesh);
    size_t size;
    unsigned char *state;
    if (!CHECK(body != NULL))
        return;
    state = save_state(body, &size);
    for (int k = 0; k < 7; k++) {
        sb_mesh changed = k == 0 ? longer : mesh;
        sb_body_def def = sb_default_body_def();
        sb_vec3 node = mesh.nodes[3];
        sb_body *other;
        if (k == 1)
            mesh.nodes[3].x += SB_EPSILON;
        if (k == 4)
            changed.regions = NULL;
        def.mesh = &changed;
        def.material = make_material(SB_COROTATED, 2e4);
        def.single_rotation = k == 2;
        def.mass = k == 3 ? SB_MASS_CONSISTENT : SB_MASS_LUMPED;
        def.integration = k == 5 ? SB_INTEGRATION_CURVED : SB_INTEGRATION_AUTO;
        def.preconditioner = k == 6 ? SB_PRECOND_SSOR : SB_PRECOND_AUTO;
        other = scene_body(&def);
        if (other)
            check_refused(other, state, size, SB_ERROR_STATE, parts[k]);
        sb_body_destroy(other);
        mesh.nodes[3] = node;
    }
    free(state);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    sb_mesh_free(&longer);
}

static void test_arguments(void)
{
    const variant *v = variants + 0;
    sb_mesh mesh = make_mesh(v->type);
    sb_body *body = make_plain_body(v, &mesh);
    unsigned char small[64];
    size_t size;
    unsigned char *state;
    if (!CHECK(body != NULL))
        return;
    state = save_state(body, &size);
    memset(small, 0x5A, sizeof small);
    CHECK(sb_body_state_size(NULL) == 0);
    CHECK_RESULT(sb_body_state_save(NULL, small, sizeof small), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_state_save(body, NULL, size), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_state_save(body, small, sizeof small), SB_ERROR_ARGUMENT);
    CHECK_INT(small[0], 0x5A);
    CHECK_RESULT(sb_body_state_load(NULL, state, size, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_state_load(body, NULL, size, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_state_load(body, NULL, 0, NULL), SB_ERROR_FORMAT);
    CHECK_RESULT(sb_body_state_save_file(body, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_state_load_file(NULL, "x", NULL), SB_ERROR_ARGUMENT);
    free(state);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- files ---- */

static void test_files(void)
{
    const char *path = "build/test_state.tmp";
    const variant *v = variants + 8;
    sb_mesh mesh = make_mesh(v->type);
    sb_body *a = make_plain_body(v, &mesh), *b = make_plain_body(v, &mesh);
    sb_error error;
    FILE *file;
    if (!CHECK(a && b))
        return;
    play(a, v, &mesh, 0, 10);
    CHECK_OK(sb_body_state_save_file(a, path, &error));
    CHECK_OK(sb_body_state_load_file(b, path, &error));
    CHECK(sb_body_state_hash(a) == sb_body_state_hash(b));
    file = fopen(path, "ab");
    if (CHECK(file != NULL)) {
        fputs("trailing", file);
        fclose(file);
    }
    CHECK_RESULT(sb_body_state_load_file(b, path, &error), SB_ERROR_FORMAT);
    CHECK(strcmp(error.file, path) == 0 && strstr(error.message, "longer") != NULL);
    file = fopen(path, "wb");
    if (CHECK(file != NULL)) {
        fputs("something else that is long enough to be a head", file);
        fclose(file);
    }
    CHECK_RESULT(sb_body_state_load_file(b, path, &error), SB_ERROR_FORMAT);
    CHECK(strcmp(error.file, path) == 0);
    CHECK(sb_body_state_hash(a) == sb_body_state_hash(b));
    remove(path);
    CHECK_RESULT(sb_body_state_load_file(b, path, &error), SB_ERROR_FILE);
    CHECK(strcmp(error.file, path) == 0);
    CHECK_RESULT(sb_body_state_load_file(b, path, NULL), SB_ERROR_FILE);
    CHECK_RESULT(sb_body_state_save_file(a, "build/no such folder/x", &error), SB_ERROR_FILE);
    CHECK(strstr(error.file, "no such folder") != NULL);
    sb_body_destroy(a);
    sb_body_destroy(b);
    sb_mesh_free(&mesh);
}

/* ---- memory ---- */

/* The loaded body's room for supports is that of a body where they were made: it grows at the same node. */
static void check_support_room(const sb_body *original, sb_body *loaded, scene_memory *memory, const sb_mesh *mesh)
{
    scene_memory own = {0, 0, 0, 0};
    sb_body *made = make_body(variants + 0, mesh, scene_allocator(&own));
    int held[100], count = 0, grown = 0;
    if (!CHECK(made && mesh->node_count <= 100))
        return;
    for (int i = 0; i < mesh->node_count; i++)
        if (sb_body_supports(original)[i])
            held[count++] = i;
    CHECK_OK(sb_body_fix_nodes(made, held, count, SB_XYZ));
    memory->calls = own.calls = 0;
    for (int i = 0; i < mesh->node_count; i++) {
        CHECK_OK(sb_body_fix_nodes(made, &i, 1, SB_XYZ));
        CHECK_OK(sb_body_fix_nodes(loaded, &i, 1, SB_XYZ));
        CHECK_INT(memory->calls, own.calls);
        grown += own.calls;
    }
    CHECK(grown > 0);
    sb_body_destroy(made);
}

/* A state with supports and iterated steps, loaded into a body that has neither: every allocation fails in turn. */
static void test_memory(void)
{
    const variant *v = variants + 0, *iterated = variants + 1;
    sb_mesh mesh = make_mesh(v->type);
    scene_memory memory = {0, 0, 0, 0};
    sb_body *a = make_plain_body(iterated, &mesh), *b = make_body(v, &mesh, scene_allocator(&memory));
    const char *path = "build/test_state_memory.tmp";
    unsigned char *state;
    size_t size;
    int calls = 0;
    if (!CHECK(a && b))
        return;
    play(a, iterated, &mesh, 0, 6);
    state = save_state(a, &size);
    CHECK_OK(sb_body_state_save_file(a, path, NULL));
    for (int fail = 1; fail < 20; fail++) {
        sb_error error;
        uint64_t before = sb_body_state_hash(b);
        int live = memory.live;
        sb_result result;
        memory.calls = 0;
        memory.fail_at = fail;
        result = sb_body_state_load(b, state, size, &error);
        memory.fail_at = 0;
        calls += result != SB_OK;
        if (result == SB_OK)
            break;
        CHECK_RESULT(result, SB_ERROR_MEMORY);
        CHECK_INT(error.result, SB_ERROR_MEMORY);
        CHECK(sb_body_state_hash(b) == before);
        CHECK(memory.live >= live); /* what was got before stays, as a reserve */
    }
    CHECK_INT(calls, 2);
    CHECK(sb_body_state_hash(a) == sb_body_state_hash(b));
    memory.calls = 0;
    CHECK_OK(sb_body_state_load(b, state, size, NULL));
    CHECK_INT(memory.calls, 0);
    check_support_room(a, b, &memory, &mesh);
    for (int fail = 1; fail < 30; fail++) {
        int live = memory.live;
        sb_result result;
        memory.calls = 0;
        memory.fail_at = fail;
        result = sb_body_state_load_file(b, path, NULL);
        memory.fail_at = 0;
        CHECK_INT(memory.live, live);
        if (result == SB_OK)
            break;
        CHECK_RESULT(result, SB_ERROR_MEMORY);
    }
    memory.calls = 0;
    memory.fail_at = 1;
    CHECK_RESULT(sb_body_state_save_file(b, path, NULL), SB_ERROR_MEMORY);
    memory.fail_at = 0;
    remove(path);
    sb_body_destroy(b);
    CHECK_INT(memory.live, 0);
    free(state);
    sb_body_destroy(a);
    sb_mesh_free(&mesh);
}

/* Numbers that a library of any machine must write: the head, and a hash of a resting body's state. */
static void test_golden_layout(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 1, 1, 1, sb_v3(1, 1, 1), 0);
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    size_t size;
    unsigned char *state;
    def.mesh = &mesh;
    def.material = make_material(SB_COROTATED, 1e4);
    body = scene_body(&def);
    if (!CHECK(body != NULL))
        return;
    state = save_state(body, &size);
    CHECK(memcmp(state, "SBSTATE\x1A\x03\0\0\0", 12) == 0);
    CHECK_INT(state[12], sizeof(sb_real));
    CHECK(((size_t)state[16] | (size_t)state[17] << 8) == size);
    CHECK_INT(state[24], 1); /* the first part: what the body is made of */
    CHECK_INT(state[28], mesh.node_count);
    CHECK_INT(state[36], mesh.element_count);
    free(state);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* After a reset a body goes on as one that never moved, whatever it learnt on the way: matrices that IC(0) has to
 * shift, multigrid's reach, the explicit step. */
static void test_reset(void)
{
    const sb_precond_kind kinds[4] = {SB_PRECOND_IC0, SB_PRECOND_SSOR, SB_PRECOND_CHOLESKY, SB_PRECOND_MULTIGRID};
    const sb_integrator integrators[4] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA, SB_CENTRAL_DIFFERENCE};
    for (int k = 0; k < 4; k++)
        for (int i = 0; i < 4; i++) {
            sb_mesh mesh = scene_box(SB_TET4, 6, 3, 3, sb_v3(REAL(0.12), REAL(0.05), REAL(0.05)), 0.2);
            sb_body_def def = sb_default_body_def();
            sb_body *used, *fresh;
            def.mesh = &mesh;
            def.material = sb_material_neo_hookean(5000, REAL(0.49), 1000);
            def.integrator = integrators[i];
            def.preconditioner = kinds[k];
            def.gravity = sb_v3(0, REAL(-9.81), 0);
            used = scene_body(&def);
            fresh = scene_body(&def);
            scene_fix_plane(used, &mesh, 0, 0, SB_XYZ);
            scene_fix_plane(fresh, &mesh, 0, 0, SB_XYZ);
            for (int s = 0; s < 25; s++)
                CHECK_OK(sb_body_step(used, REAL(0.004), NULL));
            sb_body_reset(used);
            CHECK(sb_body_state_hash(used) == sb_body_state_hash(fresh));
            for (int s = 0; s < 5; s++) {
                CHECK_OK(sb_body_step(used, REAL(0.004), NULL));
                CHECK_OK(sb_body_step(fresh, REAL(0.004), NULL));
                CHECK(sb_body_state_hash(used) == sb_body_state_hash(fresh));
            }
            sb_body_destroy(used);
            sb_body_destroy(fresh);
            sb_mesh_free(&mesh);
        }
}

CHECK_SUITE(state, {"a reset forgets", test_reset}, {"continues to the same bits", test_continue},
            {"saved at every moment", test_every_moment}, {"material switch", test_material_switch},
            {"static solves go on", test_static_goes_on}, {"failures leave no trace", test_failures_leave_no_trace},
            {"damaged states", test_damage}, {"forged values", test_forged_values}, {"forged bytes", test_forged_bytes},
            {"states of other bodies", test_other_bodies}, {"arguments", test_arguments}, {"files", test_files},
            {"memory", test_memory}, {"layout", test_golden_layout});
