/* Targets: a small mesh, a def and commands, all from bytes; saved states and recordings with bytes changed. */
#ifndef TARGET_BODY_H
#define TARGET_BODY_H

#include "fuzz.h"

/* ---- random bodies ---- */

enum { FUZZ_MAX_NODES = 60 };

static sb_element_type fuzz_element_type(int byte)
{
    static const sb_element_type types[3] = {SB_TET4, SB_TET10, SB_HEX8};
    return types[byte % 3];
}

/* A beam with some nodes moved and some indices changed, which may make it useless. */
static int fuzz_make_mesh(fuzz_bytes *bytes, sb_mesh *mesh)
{
    sb_element_type type = fuzz_element_type(fuzz_byte(bytes));
    int shape = fuzz_byte(bytes), moves = fuzz_byte(bytes) % 4, swaps = fuzz_byte(bytes) % 16 == 1, entries;
    memset(mesh, 0, sizeof *mesh);
    if (sb_mesh_beam(type, 1 + shape % 2, 1 + (type == SB_TET4 ? shape / 2 % 2 : 0), 1, sb_v3(1, 1, 1), NULL, mesh,
                     NULL) != SB_OK)
        return 0;
    if (shape & 4)
        mesh->regions = (int *)calloc((size_t)mesh->element_count, sizeof(int));
    for (int e = 0; mesh->regions && e < mesh->element_count; e++)
        mesh->regions[e] = e % 2 ? 7 : -1;
    for (int k = 0; k < moves; k++) {
        sb_vec3 *x = mesh->nodes + fuzz_byte(bytes) % mesh->node_count, d = fuzz_vector(bytes);
        *x = sb_v3_madd(*x, (sb_real)0.4, d);
    }
    entries = mesh->element_count * sb_element_node_count(type);
    if (swaps)
        mesh->elements[fuzz_byte(bytes) % entries] = fuzz_byte(bytes) - 4;
    return mesh->node_count <= FUZZ_MAX_NODES;
}

static sb_material fuzz_material(fuzz_bytes *bytes)
{
    int model = fuzz_byte(bytes);
    sb_material m = sb_material_corotated((sb_real)(100 * (1 + fuzz_byte(bytes))), (sb_real)0.3, 1000);
    if (model % 16 == 15)
        m = sb_material_neo_hookean_isochoric(sb_abs(fuzz_real(bytes)), sb_abs(fuzz_real(bytes)), 1000);
    else
        m.model = (sb_material_model)(model % 8); /* known ones, 0 too */
    if (model >= 192)
        m.lambda = 100 * fuzz_real(bytes);
    if (model >= 224)
        m.density = 1000 * fuzz_real(bytes);
    return m;
}

static sb_body *fuzz_make_body(fuzz_bytes *bytes, const sb_mesh *mesh)
{
    static const double tolerances[4] = {1e-3, 1e-6, 0.5, 1e-12};
    sb_region_material own;
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_error error;
    int kind = fuzz_byte(bytes), more = fuzz_byte(bytes);
    def.mesh = mesh;
    def.material = fuzz_material(bytes);
    own.region = 7;
    own.material = def.material;
    if (more & 1) {
        own.material = fuzz_material(bytes);
        def.region_materials = &own;
        def.region_material_count = 1;
    }
    def.integrator = kind & 1 ? SB_NEWMARK : SB_EULER;
    def.mass = (sb_mass_kind)(kind / 2 % 4 % 3);
    def.preconditioner = (sb_precond_kind)(kind / 8 % 5);
    def.single_rotation = (more & 6) == 6;
    def.integration = more & 8 ? SB_INTEGRATION_CURVED : SB_INTEGRATION_AUTO;
    def.max_newton = more & 16 ? 1 + more / 32 % 4 : SB_AUTO;
    def.tolerance = (sb_real)tolerances[more / 64];
    def.max_iterations = 40;
    if (kind >= 128) {
        def.gravity = fuzz_vector(bytes);
        def.damping_mass = fuzz_real(bytes);
        def.damping_stiffness = (sb_real)0.1 * fuzz_real(bytes);
    }
    if (sb_body_create(&def, &body, &error) != SB_OK) {
        FUZZ_REQUIRE(body == NULL && error.result != SB_OK && error.message[0]);
        return NULL;
    }
    return body;
}

/* ---- random commands ---- */

typedef struct fuzz_session {
    fuzz_bytes bytes;
    sb_body *body;
    const sb_mesh *mesh;
    void *saved;       /* a state, or NULL */
    size_t saved_size;
} fuzz_session;

/* Up to three nodes, now and then one that does not exist. */
static int fuzz_nodes(fuzz_session *s, int nodes[3])
{
    int count = 1 + fuzz_byte(&s->bytes) % 3;
    for (int i = 0; i < count; i++) {
        int b = fuzz_byte(&s->bytes);
        nodes[i] = b == 255 ? s->mesh->node_count : b == 254 ? -1 : b % s->mesh->node_count;
    }
    return count;
}

static sb_result fuzz_supports(fuzz_session *s, int kind)
{
    int nodes[3], count = fuzz_nodes(s, nodes), axes = fuzz_byte(&s->bytes) % 9;
    sb_vec3 targets[3];
    for (int i = 0; i < 3; i++)
        targets[i] = fuzz_vector(&s->bytes);
    switch (kind) {
    case 0: return sb_body_fix_nodes(s->body, nodes, count, axes);
    case 1: return sb_body_prescribe(s->body, nodes, count, axes, targets, axes & 1);
    case 2: return sb_body_release_nodes(s->body, nodes, count, axes);
    default: return sb_body_add_forces(s->body, nodes, count, targets, axes & 1);
    }
}

static sb_result fuzz_set(fuzz_session *s, int kind)
{
    fuzz_bytes *bytes = &s->bytes;
    sb_material material;
    sb_real a, b;
    int face[4];
    switch (kind) {
    case 0: material = fuzz_material(bytes); return sb_body_set_material(s->body, &material, NULL);
    case 1: material = fuzz_material(bytes); return sb_body_set_region_material(s->body, 7, &material, NULL);
    case 2: return sb_body_set_gravity(s->body, fuzz_vector(bytes));
    case 3: a = fuzz_real(bytes), b = fuzz_real(bytes); return sb_body_set_damping(s->body, a, b);
    case 4: a = fuzz_real(bytes); return sb_body_set_solver(s->body, a, fuzz_byte(bytes) % 50);
    default:
        for (int i = 0; i < 4; i++)
            face[i] = fuzz_byte(bytes) % 32 - 1;
        return sb_body_add_traction(s->body, face, 1, 3 + fuzz_byte(bytes) % 2, fuzz_vector(bytes), NULL);
    }
}

static sb_result fuzz_set_motion(fuzz_session *s, int velocities)
{
    sb_vec3 values[FUZZ_MAX_NODES];
    memset(values, 0, sizeof values);
    for (int i = 0, count = fuzz_byte(&s->bytes) % 6; i < count; i++)
        values[fuzz_byte(&s->bytes) % s->mesh->node_count] = fuzz_vector(&s->bytes);
    return velocities ? sb_body_set_velocities(s->body, values) : sb_body_set_displacements(s->body, values);
}

static void fuzz_save_state(fuzz_session *s)
{
    free(s->saved);
    s->saved_size = sb_body_state_size(s->body);
    s->saved = malloc(s->saved_size);
    FUZZ_REQUIRE(s->saved && sb_body_state_save(s->body, s->saved, s->saved_size) == SB_OK);
}

/* A saved state is always taken back. */
static void fuzz_load_state(fuzz_session *s)
{
    if (s->saved)
        FUZZ_REQUIRE(sb_body_state_load(s->body, s->saved, s->saved_size, NULL) == SB_OK);
}

static void fuzz_static(fuzz_session *s)
{
    sb_static_options options = sb_default_static_options();
    options.load_steps = fuzz_byte(&s->bytes) % 3;
    options.max_newton = fuzz_byte(&s->bytes) % 6;
    options.max_iterations = 40;
    options.keep_progress = fuzz_byte(&s->bytes) & 1;
    fuzz_solve(s->body, &options);
}

static void fuzz_read(sb_body *body)
{
    sb_real values[FUZZ_MAX_NODES * 4];
    sb_energy energy;
    sb_mat3 stress;
    sb_check_report report;
    uint64_t before = sb_body_state_hash(body);
    if (sb_body_energy(body, &energy) == SB_OK)
        FUZZ_REQUIRE(sb_is_finite(energy.elastic) && sb_is_finite(energy.kinetic));
    if (sb_body_stress(body, 0, 0, &stress) == SB_OK)
        FUZZ_REQUIRE(sb_is_finite(sb_von_mises(stress)));
    FUZZ_REQUIRE(sb_body_element_count(body) <= FUZZ_MAX_NODES * 4);
    sb_body_von_mises(body, values);
    sb_body_nodal_von_mises(body, values);
    FUZZ_REQUIRE(sb_body_check(body, &report) == SB_OK);
    FUZZ_REQUIRE(sb_body_state_hash(body) == before);
}

/* One command; a setter that fails changes nothing. */
static void fuzz_command(fuzz_session *s)
{
    int op = fuzz_byte(&s->bytes) % 24;
    uint64_t before = sb_body_state_hash(s->body);
    sb_result result = SB_OK;
    if (op < 5)
        result = fuzz_supports(s, op);
    else if (op < 11)
        result = fuzz_set(s, op - 5);
    else if (op < 13)
        result = fuzz_set_motion(s, op - 11);
    else if (op == 13)
        sb_body_clear_loads(s->body);
    else if (op == 14)
        sb_body_reset(s->body);
    else if (op == 15)
        fuzz_static(s);
    else if (op == 16)
        fuzz_save_state(s);
    else if (op == 17)
        fuzz_load_state(s);
    else if (op == 18)
        fuzz_read(s->body);
    else
        fuzz_step(s->body, sb_abs(fuzz_real(&s->bytes)) / 20);
    if (result != SB_OK)
        FUZZ_REQUIRE(sb_body_state_hash(s->body) == before);
    fuzz_check_body(s->body);
}

static void fuzz_body(const uint8_t *data, size_t size)
{
    sb_mesh mesh;
    fuzz_session s;
    memset(&s, 0, sizeof s);
    s.bytes.data = data;
    s.bytes.size = size;
    s.mesh = &mesh;
    if (fuzz_make_mesh(&s.bytes, &mesh))
        s.body = fuzz_make_body(&s.bytes, &mesh);
    for (int k = 0; s.body && k < 24 && !fuzz_is_empty(&s.bytes); k++)
        fuzz_command(&s);
    free(s.saved);
    sb_body_destroy(s.body);
    sb_mesh_free(&mesh);
}

/* ---- states and recordings with bytes changed ---- */

/* A body of one of four kinds that has been through something. */
static sb_body *fuzz_known_body(int kind, sb_mesh *mesh, sb_recording **recording)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_vec3 push = sb_v3((sb_real)0.1, 0, (sb_real)-0.2);
    int far_end, fixed[2] = {0, 1};
    memset(mesh, 0, sizeof *mesh);
    FUZZ_REQUIRE(sb_mesh_beam(fuzz_element_type(kind), 1, 1, 1, sb_v3(1, 1, 1), NULL, mesh, NULL) == SB_OK);
    far_end = mesh->node_count - 1;
    def.mesh = mesh;
    def.material = kind < 3 ? sb_material_corotated(1000, (sb_real)0.3, 1000)
                            : sb_material_neo_hookean(1000, (sb_real)0.3, 1000);
    def.integrator = kind == 1 ? SB_NEWMARK : SB_EULER;
    def.max_iterations = 40;
    FUZZ_REQUIRE(sb_body_create(&def, &body, NULL) == SB_OK);
    if (recording)
        FUZZ_REQUIRE(sb_recording_start(body, 2, NULL, recording, NULL) == SB_OK);
    FUZZ_REQUIRE(sb_body_fix_nodes(body, fixed, 2, SB_XYZ) == SB_OK);
    FUZZ_REQUIRE(sb_body_add_forces(body, &far_end, 1, &push, 1) == SB_OK);
    for (int i = 0; i < 3; i++)
        fuzz_step(body, (sb_real)0.02);
    FUZZ_REQUIRE(sb_body_set_gravity(body, push) == SB_OK);
    FUZZ_REQUIRE(sb_body_prescribe(body, &far_end, 1, SB_X, &push, 1) == SB_OK);
    fuzz_step(body, (sb_real)0.02);
    return body;
}

static void fuzz_state(const uint8_t *data, size_t size)
{
    fuzz_bytes bytes = {data, size, 0};
    sb_mesh mesh;
    sb_body *body = fuzz_known_body(fuzz_byte(&bytes) % 4, &mesh, NULL);
    uint64_t before = sb_body_state_hash(body);
    size_t length = sb_body_state_size(body);
    unsigned char *image = (unsigned char *)malloc(length);
    sb_error error;
    FUZZ_REQUIRE(image && sb_body_state_save(body, image, length) == SB_OK);
    fuzz_patch_image(&bytes, image, length);
    if (sb_body_state_load(body, image, length, &error) != SB_OK) {
        FUZZ_REQUIRE(error.message[0] && sb_body_state_hash(body) == before);
    } else {
        sb_static_options options = sb_default_static_options();
        options.max_newton = 4;
        options.max_iterations = 40;
        fuzz_check_body(body);
        FUZZ_REQUIRE(sb_body_set_solver(body, (sb_real)1e-3, 40) == SB_OK); /* the state may ask for endless work */
        fuzz_step(body, (sb_real)0.02);
        fuzz_solve(body, &options);
        fuzz_step(body, (sb_real)0.02);
        fuzz_read(body);
    }
    sb_body_state_load(body, data, size, NULL); /* the bytes themselves */
    free(image);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* 1 when a replay will not ask for more work than a fuzz target has time for. */
static int fuzz_is_short(const sb_recording *recording)
{
    sbi_record_cursor cursor = sbi_record_begin(recording);
    for (int i = 0; i < recording->commands && sbi_record_next(&cursor); i++) {
        const unsigned char *ints = cursor.ints;
        if (cursor.rule->code == SBI_COMMAND_STATE ||
            (cursor.rule->code == SBI_COMMAND_SOLVER && cursor.command.a > 100))
            return 0;
        for (int k = 0; cursor.rule->code == SBI_COMMAND_STATIC && k < 3; k++)
            if (sbi_get_bytes(ints + 4 * k, 4) > 50)
                return 0;
    }
    return 1;
}

static void fuzz_record(const uint8_t *data, size_t size)
{
    fuzz_bytes bytes = {data, size, 0};
    sb_mesh mesh;
    sb_recording *recording = NULL, *loaded = NULL;
    sb_body *body = fuzz_known_body(fuzz_byte(&bytes) % 4, &mesh, &recording);
    size_t length = sb_recording_get_info(recording).bytes;
    unsigned char *image = (unsigned char *)malloc(length);
    sb_recording_report report;
    sb_error error;
    sb_recording_stop(recording);
    FUZZ_REQUIRE(image && sb_recording_save(recording, image, length) == SB_OK);
    FUZZ_REQUIRE(sb_recording_replay(recording, body, &report) == SB_OK && report.step == -1);
    fuzz_patch_image(&bytes, image, length);
    if (sb_recording_load(image, length, NULL, &loaded, &error) != SB_OK) {
        FUZZ_REQUIRE(error.message[0] && !loaded);
    } else if (fuzz_is_short(loaded)) {
        sb_result result = sb_recording_replay(loaded, body, &report);
        FUZZ_REQUIRE(report.error.result == result && (result == SB_OK || report.error.message[0]));
        fuzz_check_body(body);
    }
    sb_recording_destroy(loaded);
    loaded = NULL;
    if (sb_recording_load(data, size, NULL, &loaded, NULL) == SB_OK)
        sb_recording_destroy(loaded);
    sb_recording_destroy(recording);
    free(image);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

#endif /* TARGET_BODY_H */
