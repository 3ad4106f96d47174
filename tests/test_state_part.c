/* Tests of state_part: a tally that others keep about a body is saved, loaded, hashed, recorded and replayed with
 * it. */
#define SB_SPLIT_BUILD
#include "../src/softbody/base/bytes.h"
#include "../src/softbody/body/state_part.h"
#include "../src/softbody/body/step_private.h"
#include "../src/softbody/mesh/mesh_private.h"

#include "check.h"
#include "scene.h"

#include <stdlib.h>

/* Sums up where a node goes, and pushes the body for it. */
typedef struct tally {
    sb_body *body;
    int count, room;
    double sums[64];
    int ready;       /* checked, and neither loaded nor given up */
    int refuses;     /* 1: checks are refused */
    sb_result fails; /* of its next steps */
} tally;

static void tally_save(const void *user, sbi_state_out *out)
{
    const tally *t = (const tally *)user;
    sbi_state_put(out, &t->count, sizeof t->count);
    sbi_state_put(out, t->sums, (size_t)t->count * sizeof(double));
}

static sb_result tally_check(void *user, const sb_body *body, const unsigned char *bytes, size_t size, sb_error *error)
{
    tally *t = (tally *)user;
    int count;
    CHECK(body != NULL && !t->ready);
    if (t->refuses)
        return sbi_fail(error, SB_ERROR_MEMORY, "the tally refuses");
    if (size < sizeof count)
        return sbi_fail(error, SB_ERROR_FORMAT, "the tally ends too early");
    memcpy(&count, bytes, sizeof count);
    if (count < 0 || count > 64 || size != sizeof count + (size_t)count * sizeof(double))
        return sbi_fail(error, SB_ERROR_FORMAT, "the tally is damaged");
    t->ready = 1;
    return SB_OK;
}

static void tally_load(void *user, const unsigned char *bytes, size_t size)
{
    tally *t = (tally *)user;
    CHECK(t->ready);
    t->ready = 0;
    memcpy(&t->count, bytes, sizeof t->count);
    memcpy(t->sums, bytes + sizeof t->count, size - sizeof t->count);
}

static void tally_give_up(void *user)
{
    tally *t = (tally *)user;
    CHECK(t->ready);
    t->ready = 0;
}

/* A push and a step, of which a recording holds one command. */
static sb_result tally_step(tally *t, int node, sb_real push)
{
    sb_vec3 force = sb_v3(0, push, 0);
    sb_result result = t->fails;
    sbi_body_mute(t->body);
    CHECK_OK(sb_body_add_forces(t->body, &node, 1, &force, 1));
    if (result == SB_OK)
        result = sb_body_step(t->body, REAL(0.01), NULL);
    sbi_body_unmute(t->body);
    t->sums[t->count % 64] = (double)sb_body_displacements(t->body)[node].y;
    t->count = t->count % 63 + 1;
    sbi_body_tell_part_step(t->body, "tally", result, &node, 1, &push, 1);
    return result;
}

static sb_result tally_replay(void *user, const int *ints, size_t int_count, const sb_real *reals, size_t real_count,
                              sb_error *error)
{
    tally *t = (tally *)user;
    if (int_count == 0 && real_count == 0) { /* forget */
        t->count = 0;
        return SB_OK;
    }
    if (int_count != 1 || real_count != 1 || ints[0] < 0 || ints[0] >= sb_body_node_count(t->body))
        return sbi_fail(error, SB_ERROR_FORMAT, "no such step of the tally");
    return tally_step(t, ints[0], reals[0]);
}

static sbi_state_part part_of(tally *t)
{
    sbi_state_part part;
    memset(&part, 0, sizeof part);
    memcpy(part.name, "tally", 6);
    part.version = 3;
    part.user = t;
    part.save = tally_save;
    part.check = tally_check;
    part.load = tally_load;
    part.give_up = tally_give_up;
    part.replay = tally_replay;
    return part;
}

/* A body that a tally has joined. */
static sb_body *scene(const sb_mesh *mesh, double slack, tally *t, const sb_allocator *allocator)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sbi_state_part part;
    def.mesh = mesh;
    def.material = sb_material_corotated(5000, REAL(0.4), 1000);
    def.slack = REAL(slack);
    if (allocator)
        def.allocator = *allocator;
    memset(t, 0, sizeof *t);
    if (sb_body_create(&def, &body, NULL) != SB_OK)
        return NULL;
    scene_fix_plane(body, mesh, 0, 0, SB_XYZ);
    t->body = body;
    part = part_of(t);
    CHECK_OK(sbi_body_join(body, &part, NULL));
    return body;
}

static sb_mesh bar(void) { return scene_box(SB_TET4, 5, 2, 2, sb_v3(REAL(0.1), REAL(0.03), REAL(0.03)), 0.1); }

static unsigned char *state_of(const sb_body *body, size_t *size)
{
    unsigned char *bytes;
    *size = sb_body_state_size(body);
    bytes = (unsigned char *)malloc(*size);
    CHECK_OK(sb_body_state_save(body, bytes, *size));
    return bytes;
}

static void test_round_trip(void)
{
    for (int live = 0; live < 2; live++) {
        sb_mesh mesh = bar();
        tally first, second;
        sb_body *a = scene(&mesh, live * 0.3, &first, NULL), *b = scene(&mesh, live * 0.3, &second, NULL);
        size_t size;
        unsigned char *bytes;
        uint64_t hash;
        int last = mesh.node_count - 1;
        if (live)
            scene_remove_cells(a); /* b has another mesh until it loads */
        for (int i = 0; i < 5; i++)
            CHECK_OK(tally_step(&first, last, REAL(0.01)));
        bytes = state_of(a, &size);
        hash = sb_body_state_hash(a);
        CHECK(hash != sb_body_state_hash(b));
        CHECK_OK(sb_body_state_load(b, bytes, size, NULL));
        CHECK(sb_body_state_hash(b) == hash);
        CHECK_INT(second.count, first.count);
        for (int i = 0; i < 5; i++) {
            CHECK_OK(tally_step(&first, last, REAL(-0.02)));
            CHECK_OK(tally_step(&second, last, REAL(-0.02)));
            CHECK(sb_body_state_hash(a) == sb_body_state_hash(b));
        }
        second.sums[0] += 1; /* the part alone differs */
        CHECK(sb_body_state_hash(a) != sb_body_state_hash(b));
        CHECK_OK(sb_body_state_load(a, bytes, size, NULL));
        CHECK(sb_body_state_hash(a) == hash);
        free(bytes);
        sb_body_destroy(a);
        sb_body_destroy(b);
        sb_mesh_free(&mesh);
    }
}

static void test_refusals(void)
{
    sb_mesh mesh = bar();
    tally first, second;
    sb_body *a = scene(&mesh, 0, &first, NULL), *b = scene(&mesh, 0, &second, NULL);
    sbi_state_part part = part_of(&second), other = part;
    size_t size, bare_size;
    unsigned char *bytes, *bare;
    sb_error error;
    uint64_t before;
    CHECK_OK(tally_step(&first, mesh.node_count - 1, REAL(0.01)));
    bytes = state_of(a, &size);
    before = sb_body_state_hash(b);
    CHECK_RESULT(sbi_body_join(b, &part, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "tally"));
    second.refuses = 1;
    CHECK_RESULT(sb_body_state_load(b, bytes, size, &error), SB_ERROR_MEMORY);
    second.refuses = 0;
    CHECK(sb_body_state_hash(b) == before);

    sbi_body_leave(b, "tally"); /* a body that has not the part */
    bare = state_of(b, &bare_size);
    CHECK_RESULT(sb_body_state_load(b, bytes, size, &error), SB_ERROR_STATE);
    CHECK(strstr(error.message, "tally"));
    CHECK_RESULT(sb_body_state_load(a, bare, bare_size, &error), SB_ERROR_STATE);
    CHECK(strstr(error.message, "tally") && !first.ready);
    sbi_body_leave(b, "tally");

    other.name[0] = 'a'; /* one more part: the tally has checked when it is refused */
    CHECK_OK(sbi_body_join(b, &part, &error));
    CHECK_OK(sbi_body_join(b, &other, &error));
    CHECK_RESULT(sb_body_state_load(b, bytes, size, &error), SB_ERROR_STATE);
    CHECK(strstr(error.message, "aally"));
    sbi_body_leave(b, "aally");
    other.name[0] = 'z';
    CHECK_OK(sbi_body_join(b, &other, &error));
    CHECK_RESULT(sb_body_state_load(b, bytes, size, &error), SB_ERROR_STATE);
    CHECK(strstr(error.message, "zally") && !second.ready);
    sbi_body_leave(b, "zally");

    sbi_body_leave(b, "tally");
    part.version = 4;
    CHECK_OK(sbi_body_join(b, &part, &error));
    CHECK_RESULT(sb_body_state_load(b, bytes, size, &error), SB_ERROR_UNSUPPORTED);
    CHECK(!second.ready);
    free(bytes);
    free(bare);
    sb_body_destroy(a);
    sb_body_destroy(b);
    sb_mesh_free(&mesh);
}

/* Images whose bytes were changed, and sealed again, are taken whole or refused with nothing changed. */
static void test_mutations(void)
{
    sb_mesh mesh = bar();
    tally first, second;
    sb_body *a = scene(&mesh, 0, &first, NULL), *b = scene(&mesh, 0, &second, NULL);
    size_t size, bare;
    unsigned char *bytes, *changed;
    unsigned long long seed = 5;
    int taken = 0;
    for (int i = 0; i < 3; i++)
        CHECK_OK(tally_step(&first, mesh.node_count - 1, REAL(0.01)));
    bytes = state_of(a, &size);
    sbi_body_leave(a, "tally");
    bare = sb_body_state_size(a) - SBI_IMAGE_TAIL; /* where the part begins */
    changed = (unsigned char *)malloc(size);
    for (int round = 0; round < 2000; round++) {
        size_t length = round % 3 ? size : bare + (size_t)(check_random(&seed) * (double)(size - bare + 1));
        uint64_t before = sb_body_state_hash(b);
        sb_error error;
        length = length < bare + SBI_IMAGE_TAIL ? bare + SBI_IMAGE_TAIL : length;
        memcpy(changed, bytes, size);
        if (round % 3)
            changed[bare + (size_t)(check_random(&seed) * (double)(size - bare - SBI_IMAGE_TAIL))] ^=
                (unsigned char)(1 << (int)(check_random(&seed) * 8));
        sbi_image_seal(changed, length, (const char *)bytes, (uint32_t)sbi_get_bytes(bytes + 8, 4));
        if (sb_body_state_load(b, changed, length, &error) == SB_OK)
            taken++;
        else
            CHECK(sb_body_state_hash(b) == before && error.message[0]);
        CHECK(!second.ready);
    }
    CHECK(taken > 0 && taken < 2000);
    free(changed);
    free(bytes);
    sb_body_destroy(a);
    sb_body_destroy(b);
    sb_mesh_free(&mesh);
}

static void test_recording(void)
{
    sb_mesh mesh = bar();
    tally first, second;
    sb_body *a = scene(&mesh, 0, &first, NULL), *b = scene(&mesh, 0, &second, NULL);
    sb_recording *recording, *loaded;
    sb_recording_report report;
    sb_recording_info info;
    unsigned char *bytes;
    sb_error error;
    CHECK_OK(tally_step(&first, 7, REAL(0.02)));
    CHECK_OK(sb_recording_start(a, 1, NULL, &recording, &error));
    for (int i = 0; i < 4; i++) {
        CHECK_OK(tally_step(&first, mesh.node_count - 1 - i, REAL(0.01)));
        CHECK_OK(sb_body_step(a, REAL(0.005), NULL));
    }
    first.fails = SB_ERROR_DIVERGED;
    CHECK_RESULT(tally_step(&first, 9, REAL(0.01)), SB_ERROR_DIVERGED);
    first.fails = SB_OK;
    first.count = 0;
    sbi_body_tell_part(a, "tally", NULL, 0, NULL, 0);
    CHECK_OK(tally_step(&first, 11, REAL(0.01)));
    info = sb_recording_get_info(recording);
    CHECK_INT(info.commands, 11); /* none of what the tally did on its own */
    CHECK_INT(info.steps, 10);
    bytes = (unsigned char *)malloc(info.bytes);
    CHECK_OK(sb_recording_save(recording, bytes, info.bytes));
    if (CHECK_OK(sb_recording_load(bytes, info.bytes, NULL, &loaded, &error))) {
        CHECK_RESULT(sb_recording_replay(loaded, b, &report),
                     SB_ERROR_STATE); /* its fifth step does not fail by itself */
        CHECK_INT(report.step, 8);
        CHECK_RESULT(report.expected, SB_ERROR_DIVERGED);
        sbi_body_leave(b, "tally");
        CHECK_RESULT(sb_recording_replay(loaded, b, &report), SB_ERROR_STATE);
        CHECK(strstr(report.error.message, "tally"));
        sb_recording_destroy(loaded);
    }
    sb_recording_destroy(recording);
    CHECK_OK(sb_recording_start(a, 1, NULL, &recording, &error));
    for (int i = 0; i < 4; i++)
        CHECK_OK(tally_step(&first, mesh.node_count - 1 - i, REAL(0.01)));
    sb_body_destroy(b);
    b = scene(&mesh, 0, &second, NULL);
    CHECK_OK(sb_recording_replay(recording, b, &report));
    CHECK_INT(report.steps, 4);
    CHECK(sb_body_state_hash(a) == sb_body_state_hash(b));
    sb_recording_destroy(recording);
    free(bytes);
    sb_body_destroy(a);
    sb_body_destroy(b);
    sb_mesh_free(&mesh);
}

/* A body whose count of nodes rises and falls while it is recorded: calls with a vector per node, and positions. */
static void test_counts(void)
{
    sb_mesh mesh = bar();
    tally first, second;
    sb_body *a = scene(&mesh, 0.5, &first, NULL), *b = scene(&mesh, 0.5, &second, NULL);
    sb_recording *recording, *loaded;
    sb_recording_report report;
    sb_recording_info info;
    unsigned char *bytes;
    sb_error error;
    CHECK_OK(sb_recording_start(a, 1, NULL, &recording, &error));
    for (int round = 0; round < 2; round++) {
        int made[4], cell[4], count = sb_body_node_count(a);
        sb_real quarter[4] = {REAL(0.25), REAL(0.25), REAL(0.25), REAL(0.25)};
        sb_vec3 middle = sb_v3(0, 0, 0), *moves;
        sb_body_change *change;
        memcpy(cell, sb_body_cell_nodes(a, 3 + round), sizeof cell);
        for (int c = 0; c < 4; c++)
            middle = sb_v3_madd(middle, REAL(0.25), sb_body_rest_positions(a)[cell[c]]);
        CHECK_OK(sb_body_change_begin(a, &change, &error));
        CHECK_OK(sb_body_change_add_node(change, middle, cell, quarter, 4, 0, made, &error));
        for (int c = 0; c < 4; c++) {
            sb_change_cell part = sb_default_change_cell();
            int nodes[4];
            memcpy(nodes, cell, sizeof nodes);
            nodes[c] = made[0];
            part.nodes = nodes;
            part.parent = 3 + round;
            if (c == 0)
                CHECK_OK(sb_body_change_replace_cell(change, 3 + round, &part, &error));
            else
                CHECK_OK(sb_body_change_add_cell(change, &part, NULL, &error));
        }
        CHECK_OK(sb_body_change_commit(change, &error));
        CHECK_INT(sb_body_node_count(a), count + 1);
        moves = (sb_vec3 *)calloc((size_t)count + 1, sizeof *moves);
        moves[made[0]] = sb_v3(0, 0, REAL(1e-3));
        CHECK_OK(sb_body_set_displacements(a, moves));
        CHECK_OK(sb_body_set_velocities(a, moves));
        free(moves);
        CHECK_OK(sb_body_step(a, REAL(0.01), NULL));
    }
    info = sb_recording_get_info(recording);
    bytes = (unsigned char *)malloc(info.bytes);
    CHECK_OK(sb_recording_save(recording, bytes, info.bytes));
    if (CHECK_OK(sb_recording_load(bytes, info.bytes, NULL, &loaded, &error))) {
        CHECK_OK(sb_recording_replay(loaded, b, &report));
        CHECK_INT(report.steps, 2);
        CHECK(sb_body_state_hash(a) == sb_body_state_hash(b));
        sb_recording_destroy(loaded);
    }
    sb_recording_destroy(recording);
    free(bytes);
    sb_body_destroy(a);
    sb_body_destroy(b);
    sb_mesh_free(&mesh);
}

/* A snapshot brings the body back whatever was done to it, and leaves alone what others keep. */
static void test_snapshots(void)
{
    for (int live = 0; live < 2; live++) {
        sb_mesh mesh = bar();
        tally first;
        sb_body *body = scene(&mesh, live * 0.3, &first, NULL);
        int last = mesh.node_count - 1, load = 0, face[3];
        sb_boundary boundary;
        size_t size;
        void *kept;
        uint64_t hash;
        for (int round = 0; round < 3; round++) {
            int count;
            CHECK_OK(tally_step(&first, last, REAL(0.01)));
            size = sbi_body_snapshot_size(body);
            kept = malloc(size);
            sbi_body_snapshot(body, kept, NULL);
            hash = sb_body_state_hash(body);
            count = first.count;
            CHECK_OK(sb_body_step(body, REAL(0.02), NULL));
            if (round == 1 && CHECK_OK(sb_mesh_boundary(&mesh, 1, NULL, &boundary, NULL))) {
                for (int k = 0; k < 3; k++)
                    face[k] = boundary.nodes[boundary.surface.elements[k]];
                CHECK_OK(sb_body_add_pressure(body, face, 1, 3, 10, &load, NULL));
                sb_boundary_free(&boundary);
            }
            if (round == 2 && live)
                scene_remove_cells(body);
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
            CHECK(sb_body_state_hash(body) != hash);
            CHECK_OK(sbi_body_rewind(body, kept, size, NULL));
            CHECK(sb_body_state_hash(body) == hash);
            CHECK_INT(first.count, count);
            free(kept);
        }
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* What a body goes through between two snapshots. */
static void snapshot_deed(sb_body *body, int deed, const unsigned char *kept, size_t size)
{
    sb_vec3 load = sb_v3(0, 0, REAL(0.02));
    int last = sb_body_node_count(body) - 1;
    if (deed % 7 == 3)
        CHECK_OK(sb_body_keep_tangent(body, deed == 3 ? 0 : REAL(0.05), NULL));
    if (deed % 5 == 4)
        CHECK_OK(sbi_body_rewind(body, kept, size, NULL));
    if (deed % 4 == 1)
        CHECK_OK(sb_body_add_forces(body, &last, 1, &load, 1));
    if (deed == 12 && sb_body_mesh_version(body) == 0 && body->live)
        scene_remove_cells(body);
    if (deed % 6 != 5)
        CHECK_OK(sb_body_step(body, REAL(0.004), NULL));
}

/* Over the one before, a snapshot comes to the bytes of one that is written whole. */
static void test_snapshots_again(void)
{
    for (int live = 0; live < 2; live++) {
        sb_mesh mesh = bar();
        tally first;
        sb_body *body = scene(&mesh, live * 0.3, &first, NULL);
        const size_t head = SBI_IMAGE_HEAD; /* which a snapshot leaves out */
        size_t room = 2 * sbi_body_snapshot_size(body), size = 0;
        unsigned char *over = (unsigned char *)malloc(room), *whole = (unsigned char *)malloc(room);
        sbi_snapshot_held held, before;
        int kept = 0, anew = 0;
        memset(&held, 0, sizeof held);
        CHECK_OK(sb_body_keep_tangent(body, REAL(0.05), NULL));
        memset(over, 0x55, room);
        for (int deed = 0; deed < 40; deed++) {
            if (deed > 0)
                snapshot_deed(body, deed, over, size);
            size = sbi_body_snapshot_size(body);
            if (!CHECK(size <= room))
                break;
            memset(whole, 0xAA, size);
            before = held;
            sbi_body_snapshot(body, over, &held);
            sbi_body_snapshot(body, whole, NULL);
            CHECK(memcmp(over + head, whole + head, size - head) == 0);
            memset(over + size, deed, room - size); /* what others keep behind it */
            CHECK((held.mesh_at > 0) == live);
            kept += held.tangent_at > 0 && held.tangent_stamp == before.tangent_stamp;
            anew += held.tangent_at > 0 && held.tangent_stamp != before.tangent_stamp;
        }
        CHECK(kept > 5);
        CHECK(anew > 5);
        free(over);
        free(whole);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

CHECK_SUITE(state_part, {"there and back", test_round_trip}, {"refusals", test_refusals},
            {"changed images", test_mutations}, {"recordings", test_recording},
            {"a count of nodes that changes", test_counts}, {"snapshots", test_snapshots},
            {"snapshots over others", test_snapshots_again});
