/* Tests of recordings: a session plays again to the last bit, and what differs is found. */
#include "softbody.h"

#include "check.h"
#include "image.h"
#include "scene.h"

static sb_mesh make_mesh(void) { return scene_box(SB_TET4, 5, 2, 2, sb_v3(REAL(0.2), REAL(0.05), REAL(0.05)), 0); }

static sb_body *make_body_with(const sb_mesh *mesh, double young, sb_jobs jobs)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = sb_material_corotated(REAL(young), REAL(0.4), REAL(1000));
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.damping_stiffness = REAL(0.01);
    def.jobs = jobs;
    return scene_body(&def);
}

static sb_body *make_body(const sb_mesh *mesh)
{
    sb_jobs none;
    memset(&none, 0, sizeof none);
    return make_body_with(mesh, 2e4, none);
}

enum { SESSION_STEPS = 26 }; /* of play_session: 24 frames, one static solve, one that fails */

/* Every kind of call there is. */
static void play_session(sb_body *body, const sb_mesh *mesh)
{
    int tool = mesh->node_count - 1, ends[2] = {mesh->node_count / 2, mesh->node_count / 3}, face[3] = {0, 0, 0};
    sb_vec3 pushes[2] = {{REAL(0.01), 0, 0}, {0, REAL(0.02), 0}}, zero = {0, 0, 0};
    sb_vec3 far_away = {SB_REAL_MAX / 8, 0, 0};
    sb_vec3 *copy = (sb_vec3 *)calloc((size_t)mesh->node_count, sizeof *copy);
    sb_material soft = sb_material_stable_neo_hookean(REAL(1e4), REAL(0.4), REAL(900));
    sb_static_options options = sb_default_static_options();
    sb_boundary boundary;
    size_t size = sb_body_state_size(body);
    void *state = malloc(size);
    if (CHECK_OK(sb_mesh_boundary(mesh, 1, NULL, &boundary, NULL))) {
        for (int k = 0; k < 3; k++)
            face[k] = boundary.nodes[boundary.surface.elements[k]];
        sb_boundary_free(&boundary);
    }
    scene_fix_plane(body, mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_set_gravity(body, sb_v3(0, REAL(1), REAL(-5))));
    CHECK_OK(sb_body_set_damping(body, REAL(0.1), REAL(0.02)));
    CHECK_OK(sb_body_set_solver(body, REAL(1e-4), 300));
    for (int frame = 0; frame < 24 && copy && state; frame++) {
        sb_vec3 pull = sb_v3(0, 0, REAL(0.0004) * REAL(frame));
        CHECK_OK(sb_body_prescribe(body, &tool, 1, SB_Z, &pull, 1));
        if (frame == 3)
            CHECK_OK(sb_body_add_forces(body, ends, 2, pushes, 0));
        if (frame == 4)
            CHECK_OK(sb_body_add_forces(body, ends, 2, pushes, 1));
        if (frame == 5)
            CHECK_OK(sb_body_add_traction(body, face, 1, 3, sb_v3(0, 0, REAL(-20)), NULL));
        if (frame == 7)
            CHECK_OK(sb_body_state_save(body, state, size));
        if (frame == 8)
            CHECK_OK(sb_body_set_region_material(body, 0, &soft, NULL));
        if (frame == 10)
            sb_body_clear_loads(body);
        if (frame == 11)
            CHECK_OK(sb_body_set_material(body, &soft, NULL));
        if (frame == 13) {
            CHECK_OK(sb_body_add_forces(body, &tool, 1, &far_away, 1));
            sb_body_clear_loads(body);
            CHECK_OK(sb_body_state_load(body, state, size, NULL));
        }
        if (frame == 15) {
            CHECK_OK(sb_body_prescribe(body, ends, 2, SB_Y, pushes, 0));
            CHECK_OK(sb_body_prescribe(body, ends, 2, SB_X, &zero, 1));
        }
        if (frame == 16)
            CHECK_OK(sb_body_release_nodes(body, ends, 2, SB_XYZ));
        if (frame == 18) {
            memcpy(copy, sb_body_displacements(body), (size_t)mesh->node_count * sizeof *copy);
            CHECK_OK(sb_body_set_displacements(body, copy));
            memcpy(copy, sb_body_velocities(body), (size_t)mesh->node_count * sizeof *copy);
            CHECK_OK(sb_body_set_velocities(body, copy));
        }
        if (frame == 19) {
            options.load_steps = 2;
            CHECK_OK(sb_body_solve_static(body, &options, NULL));
        }
        if (frame == 20) {
            CHECK_OK(sb_body_add_forces(body, &tool, 1, &far_away, 1));
            CHECK(sb_body_step(body, REAL(0.01), NULL) != SB_OK);
            sb_body_clear_loads(body);
        }
        if (frame == 22)
            sb_body_reset(body);
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    }
    CHECK(sb_body_set_gravity(body, sb_v3(SB_REAL_MAX * 2, 0, 0)) != SB_OK); /* refused calls are not recorded */
    CHECK(sb_body_step(body, 0, NULL) != SB_OK);
    free(copy);
    free(state);
}

static unsigned char *save_recording(const sb_recording *recording, size_t *size)
{
    unsigned char *bytes;
    *size = sb_recording_get_info(recording).bytes;
    bytes = (unsigned char *)malloc(*size);
    CHECK_OK(sb_recording_save(recording, bytes, *size));
    return bytes;
}

static void test_replay(void)
{
    check_bad_numbers();
    sb_mesh mesh = make_mesh();
    int workers = 3;
    sb_body *body = make_body(&mesh), *unrecorded = make_body(&mesh);
    sb_body *threaded = make_body_with(&mesh, 2e4, scene_jobs(&workers));
    sb_recording *recording = NULL, *copy = NULL;
    sb_recording_report report;
    sb_recording_info info;
    unsigned char *bytes;
    size_t size;
    if (!CHECK(body && unrecorded && threaded) || !CHECK_OK(sb_recording_start(body, 5, NULL, &recording, NULL)))
        return;
    play_session(body, &mesh);
    play_session(unrecorded, &mesh);
    CHECK(sb_body_state_hash(body) == sb_body_state_hash(unrecorded));
    info = sb_recording_get_info(recording);
    CHECK_INT(info.steps, SESSION_STEPS);
    CHECK(info.complete && info.recording && info.commands > 2 * SESSION_STEPS);
    CHECK_RESULT(sb_recording_replay(recording, body, &report), SB_ERROR_ARGUMENT);

    CHECK_OK(sb_recording_replay(recording, threaded, &report));
    CHECK_INT(report.steps, SESSION_STEPS);
    CHECK_INT(report.commands, info.commands);
    CHECK(report.step == -1 && report.first_node == -1 && report.error.result == SB_OK);
    CHECK(sb_body_state_hash(threaded) == sb_body_state_hash(body));

    bytes = save_recording(recording, &size);
    sb_recording_stop(recording);
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    CHECK_INT(sb_recording_get_info(recording).commands, info.commands);
    CHECK_OK(sb_recording_load(bytes, size, NULL, &copy, NULL));
    CHECK_OK(sb_recording_replay(copy, body, NULL)); /* no longer the one being recorded */
    CHECK(sb_body_state_hash(threaded) == sb_body_state_hash(body));
    CHECK(!sb_recording_get_info(copy).recording);
    CHECK(sb_recording_get_info(copy).bytes == size);
    free(bytes);
    sb_recording_destroy(copy);
    sb_recording_destroy(recording);
    sb_body_destroy(body);
    sb_body_destroy(unrecorded);
    sb_body_destroy(threaded);
    sb_mesh_free(&mesh);
}

/* ---- differences ---- */

/* A recording of STEPS steps, of which step PUSH has a push at a node that the tests change. */
enum { STEPS = 12, PUSH = 7 };
static const double push_force = 0.1234567; /* N: bytes that no other number in a recording has by chance */

static sb_recording *record_push(sb_body *body, const sb_mesh *mesh, int positions_every)
{
    int node = mesh->node_count - 1;
    sb_vec3 push = sb_v3(REAL(push_force), 0, 0);
    sb_recording *recording = NULL;
    scene_fix_plane(body, mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_recording_start(body, positions_every, NULL, &recording, NULL));
    for (int s = 0; s < STEPS; s++) {
        if (s == PUSH)
            CHECK_OK(sb_body_add_forces(body, &node, 1, &push, 1));
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    }
    sb_recording_stop(recording);
    return recording;
}

/* Loads a changed recording and plays it. */
static sb_result replay_bytes(unsigned char *bytes, size_t size, sb_body *body, sb_recording_report *report)
{
    sb_recording *recording = NULL;
    sb_result result;
    image_seal(bytes, size);
    if (!CHECK_OK(sb_recording_load(bytes, size, NULL, &recording, NULL)))
        return SB_ERROR_FORMAT;
    result = sb_recording_replay(recording, body, report);
    sb_recording_destroy(recording);
    return result;
}

/* Another push: the step that had it is named, and the first node that goes elsewhere. */
static void check_other_push(int positions_every)
{
    sb_mesh mesh = make_mesh();
    sb_body *body = make_body(&mesh), *other = make_body(&mesh);
    sb_recording_report report;
    if (CHECK(body && other)) {
        sb_recording *recording = record_push(body, &mesh, positions_every);
        int sixteenth = (mesh.node_count + 15) / 16, full = positions_every > 0 && PUSH % positions_every == 0;
        size_t size;
        unsigned char *bytes = save_recording(recording, &size);
        size_t at = image_find_real(bytes, size, 100, REAL(push_force));
        CHECK_OK(sb_recording_replay(recording, other, &report));
        CHECK_INT(report.steps, STEPS);
        image_put_real(bytes + at, REAL(1.5 * push_force));
        CHECK_RESULT(replay_bytes(bytes, size, other, &report), SB_ERROR_STATE);
        CHECK_INT(report.error.result, SB_ERROR_STATE);
        CHECK_INT(report.step, PUSH);
        CHECK_INT(report.steps, PUSH);
        CHECK(report.expected == SB_OK && report.actual == SB_OK && report.expected_hash != report.actual_hash);
        CHECK(report.actual_hash == sb_body_state_hash(other));
        CHECK(strstr(report.error.message, "step 7") != NULL);
        CHECK(report.first_node >= 0 && report.last_node - report.first_node == (full ? 0 : sixteenth - 1));
        CHECK(report.error.node == report.first_node);
        CHECK(full ? report.distance > 0 && report.distance < REAL(1e-3) : report.distance == -1);
        sb_recording_destroy(recording);
        free(bytes);
    }
    sb_body_destroy(body);
    sb_body_destroy(other);
    sb_mesh_free(&mesh);
}

static void test_differences(void)
{
    check_other_push(0);
    check_other_push(1);
    check_other_push(2);
    check_other_push(7);
}

/* Node and distance are right: another run is compared with what the report says. */
static void test_distance(void)
{
    sb_mesh mesh = make_mesh();
    sb_body *body = make_body(&mesh), *other = make_body(&mesh);
    sb_recording *recording = NULL;
    sb_recording_report report;
    if (CHECK(body && other)) {
        sb_vec3 *moved = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof *moved);
        const int node = mesh.node_count / 2;
        unsigned char *bytes;
        size_t size, at;
        for (int i = 0; i < mesh.node_count; i++) /* all held: nothing moves but where it is put */
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_XYZ));
        moved[node].y = REAL(0.0625);
        CHECK_OK(sb_recording_start(body, 1, NULL, &recording, NULL));
        CHECK_OK(sb_body_prescribe(body, &node, 1, SB_XYZ, moved + node, 1));
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        bytes = save_recording(recording, &size);
        at = image_find_real(bytes, size, 56 + sb_body_state_size(body), REAL(0.0625));
        image_put_real(bytes + at, REAL(0.09375));
        CHECK_RESULT(replay_bytes(bytes, size, other, &report), SB_ERROR_STATE);
        CHECK_INT(report.first_node, node);
        CHECK_INT(report.last_node, node);
        CHECK_NEAR(report.distance, 0.03125, 1e-12);
        free(bytes);
        free(moved);
    }
    sb_recording_destroy(recording);
    sb_body_destroy(body);
    sb_body_destroy(other);
    sb_mesh_free(&mesh);
}

/* A recorded failure that does not happen again, and a hash that no displacement explains. */
static void test_other_results(void)
{
    sb_mesh mesh = make_mesh();
    sb_body *body = make_body(&mesh), *other = make_body(&mesh);
    sb_recording_report report;
    if (CHECK(body && other)) {
        sb_recording *recording = record_push(body, &mesh, 0);
        size_t size, step;
        unsigned char *bytes = save_recording(recording, &size);
        step = size - 8 - (32 + sizeof(sb_real) + 136); /* the last command: a step without positions */
        CHECK_INT(image_number(bytes + step, 4), 15);
        image_put(bytes + step + 4, (uint64_t)(uint32_t)SB_ERROR_INVERTED, 4);
        CHECK_RESULT(replay_bytes(bytes, size, other, &report), SB_ERROR_STATE);
        CHECK_INT(report.step, STEPS - 1);
        CHECK(report.expected == SB_ERROR_INVERTED && report.actual == SB_OK && report.first_node == -1);
        CHECK(strstr(report.error.message, "SB_ERROR_INVERTED") != NULL);
        image_put(bytes + step + 4, 0, 4);
        bytes[step + 32 + sizeof(sb_real)] ^= 1;
        CHECK_RESULT(replay_bytes(bytes, size, other, &report), SB_ERROR_STATE);
        CHECK(report.step == STEPS - 1 && report.first_node == -1 && report.last_node == -1);
        CHECK(strstr(report.error.message, "same displacements") != NULL);
        image_put_real(bytes + step + 32, -1); /* dt */
        CHECK_RESULT(replay_bytes(bytes, size, other, &report), SB_ERROR_STATE);
        CHECK_INT(report.actual, SB_ERROR_ARGUMENT);
        CHECK(strstr(report.error.message, "dt > 0") != NULL);
        sb_recording_destroy(recording);
        free(bytes);
    }
    sb_body_destroy(body);
    sb_body_destroy(other);
    sb_mesh_free(&mesh);
}

/* Another body: not such a one, or one whose commands are refused. */
static void test_other_bodies(void)
{
    sb_mesh mesh = make_mesh(), larger = scene_box(SB_TET4, 6, 2, 2, sb_v3(1, 1, 1), 0);
    sb_body *body = make_body(&mesh), *other = make_body(&larger);
    sb_recording_report report;
    if (CHECK(body && other)) {
        sb_recording *recording = record_push(body, &mesh, 0);
        uint64_t before = sb_body_state_hash(other);
        size_t size, at;
        unsigned char *bytes = save_recording(recording, &size);
        CHECK_RESULT(sb_recording_replay(recording, other, &report), SB_ERROR_STATE);
        CHECK(report.commands == 0 && report.step == -1 && report.error.message[0]);
        CHECK(sb_body_state_hash(other) == before);
        at = image_find_real(bytes, size, 100, REAL(push_force)) - 4; /* the node before the force */
        CHECK_INT(image_number(bytes + at, 4), mesh.node_count - 1);
        image_put(bytes + at, (uint64_t)mesh.node_count, 4);
        CHECK_RESULT(replay_bytes(bytes, size, body, &report), SB_ERROR_INDEX);
        CHECK(report.steps == PUSH && report.step == -1);
        CHECK(strstr(report.error.message, "(forces) was refused") != NULL);
        CHECK_RESULT(sb_recording_replay(NULL, body, &report), SB_ERROR_ARGUMENT);
        CHECK_RESULT(sb_recording_replay(recording, NULL, NULL), SB_ERROR_ARGUMENT);
        sb_recording_destroy(recording);
        free(bytes);
    }
    sb_body_destroy(body);
    sb_body_destroy(other);
    sb_mesh_free(&mesh);
    sb_mesh_free(&larger);
}

/* ---- files ---- */

static void test_damage(void)
{
    sb_mesh mesh = make_mesh();
    sb_body *body = make_body(&mesh);
    sb_recording *recording, *loaded = NULL;
    sb_error error;
    unsigned char *bytes, *bad;
    size_t size;
    if (!CHECK(body != NULL))
        return;
    recording = record_push(body, &mesh, 3);
    bytes = save_recording(recording, &size);
    bad = (unsigned char *)malloc(size);
    for (size_t cut = 0; cut < size; cut += cut < 100 ? 1 : 131) {
        CHECK_RESULT(sb_recording_load(bytes, cut, NULL, &loaded, &error), SB_ERROR_FORMAT);
        CHECK(error.message[0] && !loaded);
    }
    for (size_t at = 0; at < size; at += at < 100 ? 1 : 131) {
        memcpy(bad, bytes, size);
        bad[at] ^= 0x11;
        CHECK(sb_recording_load(bad, size, NULL, &loaded, &error) != SB_OK && !loaded);
    }
    for (size_t at = 24; at < size; at += at < 60 ? 1 : 29) { /* with a right checksum: refused, or it plays somehow */
        memcpy(bad, bytes, size);
        bad[at] ^= 0xFF;
        image_seal(bad, size);
        if (sb_recording_load(bad, size, NULL, &loaded, NULL) == SB_OK) {
            sb_recording_report report;
            sb_recording_replay(loaded, body, &report);
            CHECK(scene_all_finite(sb_body_positions(body), mesh.node_count));
            CHECK(scene_all_finite(sb_body_velocities(body), mesh.node_count));
            sb_recording_destroy(loaded);
            loaded = NULL;
        }
    }
    free(bad);
    free(bytes);
    sb_recording_destroy(recording);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_files(void)
{
    const char *path = "build/test_record.tmp";
    sb_mesh mesh = make_mesh();
    sb_body *body = make_body(&mesh);
    sb_recording *recording, *loaded = NULL;
    sb_recording_report report;
    sb_error error;
    if (!CHECK(body != NULL))
        return;
    recording = record_push(body, &mesh, 3);
    CHECK_OK(sb_recording_save_file(recording, path, &error));
    CHECK_OK(sb_recording_load_file(path, NULL, &loaded, &error));
    CHECK_OK(sb_recording_replay(loaded, body, &report));
    CHECK_INT(report.steps, STEPS);
    sb_recording_destroy(loaded);
    loaded = NULL;
    CHECK_OK(sb_body_state_save_file(body, path, NULL)); /* a file, but of another kind */
    CHECK_RESULT(sb_recording_load_file(path, NULL, &loaded, &error), SB_ERROR_FORMAT);
    CHECK(strcmp(error.file, path) == 0 && strstr(error.message, "recording") != NULL && !loaded);
    remove(path);
    CHECK_RESULT(sb_recording_load_file(path, NULL, &loaded, &error), SB_ERROR_FILE);
    CHECK_RESULT(sb_recording_save_file(recording, "build/no such folder/x", &error), SB_ERROR_FILE);
    CHECK_RESULT(sb_recording_save_file(recording, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_recording_load_file(NULL, NULL, &loaded, NULL), SB_ERROR_ARGUMENT);
    sb_recording_destroy(recording);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- lifetime and memory ---- */

static void test_lifetime(void)
{
    sb_mesh mesh = make_mesh();
    sb_body *body = make_body(&mesh), *other = make_body(&mesh);
    sb_recording *recording = NULL, *second = NULL;
    char small[64] = {0};
    if (!CHECK(body && other))
        return;
    CHECK_RESULT(sb_recording_start(NULL, 0, NULL, &recording, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_recording_start(body, -1, NULL, &recording, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_recording_start(body, 0, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_OK(sb_recording_start(body, 0, NULL, &recording, NULL));
    CHECK_RESULT(sb_recording_start(body, 0, NULL, &second, NULL), SB_ERROR_ARGUMENT);
    CHECK(!second);
    CHECK_RESULT(sb_recording_save(recording, small, sizeof small), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_recording_save(NULL, small, sizeof small), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_recording_load(NULL, 0, NULL, &second, NULL), SB_ERROR_FORMAT);
    CHECK_RESULT(sb_recording_load(small, sizeof small, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    sb_recording_stop(recording);
    sb_recording_stop(recording);
    CHECK_OK(sb_recording_start(body, 0, NULL, &second, NULL)); /* the next one may follow */
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    sb_body_destroy(body); /* before its recording */
    CHECK(!sb_recording_get_info(second).recording);
    CHECK_INT(sb_recording_get_info(second).steps, 1);
    CHECK_OK(sb_recording_replay(recording, other, NULL));
    CHECK_OK(sb_recording_replay(second, other, NULL));
    sb_recording_destroy(recording);
    sb_recording_destroy(second);
    sb_recording_destroy(NULL);
    sb_recording_stop(NULL);
    sb_body_destroy(other);
    sb_mesh_free(&mesh);
}

/* Every allocation of a recording fails in turn: starting says so; later the body goes on and the recording ends. */
static void test_memory(void)
{
    check_bad_numbers();
    sb_mesh mesh = make_mesh();
    int refused = 0, cut_short = 0;
    for (int fail = 1; fail < 30; fail++) {
        scene_memory memory = {0, 0, 0, 0};
        sb_allocator allocator = scene_allocator(&memory);
        sb_body *body = make_body(&mesh), *plain = make_body(&mesh);
        sb_recording *recording = NULL;
        sb_result result;
        memory.fail_at = fail;
        result = sb_recording_start(body, 1, &allocator, &recording, NULL);
        if (result == SB_OK) {
            int complete;
            play_session(body, &mesh);
            play_session(plain, &mesh);
            CHECK(sb_body_state_hash(body) == sb_body_state_hash(plain));
            complete = sb_recording_get_info(recording).complete;
            memory.fail_at = 0;
            sb_recording_stop(recording);
            CHECK_OK(sb_recording_replay(recording, plain, NULL)); /* as far as it goes */
            if (!complete)
                CHECK(sb_recording_get_info(recording).steps < SESSION_STEPS);
            cut_short += !complete;
            if (complete)
                fail = 30;
        } else {
            CHECK_RESULT(result, SB_ERROR_MEMORY);
            CHECK(!recording);
            refused++;
        }
        sb_recording_destroy(recording);
        CHECK_INT(memory.live, 0);
        sb_body_destroy(body);
        sb_body_destroy(plain);
    }
    CHECK_INT(refused, 2);
    CHECK(cut_short >= 2);
    sb_mesh_free(&mesh);
}

/* The same for loading and replaying. */
static void test_replay_memory(void)
{
    const char *path = "build/test_record_memory.tmp";
    sb_mesh mesh = make_mesh();
    sb_body *body = make_body(&mesh);
    sb_recording *recording;
    int failures = 0;
    if (!CHECK(body != NULL))
        return;
    recording = record_push(body, &mesh, 0);
    CHECK_OK(sb_recording_save_file(recording, path, NULL));
    for (int fail = 1; fail < 40; fail++) {
        scene_memory memory = {0, 0, 0, 0};
        sb_allocator allocator = scene_allocator(&memory);
        sb_recording *loaded = NULL;
        sb_error error;
        sb_result result;
        memory.fail_at = fail;
        result = sb_recording_load_file(path, &allocator, &loaded, &error);
        if (result == SB_OK)
            result = sb_recording_replay(loaded, body, NULL);
        if (result == SB_OK)
            result = sb_recording_save_file(loaded, path, &error);
        sb_recording_destroy(loaded);
        CHECK_INT(memory.live, 0);
        if (result == SB_OK)
            break;
        CHECK_RESULT(result, SB_ERROR_MEMORY);
        failures++;
    }
    CHECK(failures > 6);
    remove(path);
    sb_recording_destroy(recording);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(record, {"plays again", test_replay}, {"differences", test_differences},
            {"where and how far", test_distance}, {"other results", test_other_results},
            {"other bodies", test_other_bodies}, {"damaged recordings", test_damage}, {"files", test_files},
            {"lifetime", test_lifetime}, {"memory", test_memory}, {"memory of a replay", test_replay_memory});
