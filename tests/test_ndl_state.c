/* ndl_state: saved states of bodies with a remesher and of rods: what follows a load is what followed the save, bit for
 * bit. */
#include "image.h"
#include "scene.h"

#include "needle.h"

/* ---- a needle in tissue ---- */

typedef struct patient {
    sb_mesh mesh;
    int *regions;
    scene_memory memory;
    sb_body *body;
    ndl_remesh *remesh;
    sb_vec3 entry;
} patient;

typedef struct patient_options {
    sb_real slack, release_above;
    int materials, max_needles;
} patient_options;

static patient_options patient_default(void)
{
    patient_options o;
    o.slack = REAL(0.2);
    o.release_above = REAL(0.6);
    o.materials = 2;
    o.max_needles = 2;
    return o;
}

static int patient_create(patient *p, const patient_options *o)
{
    sb_body_def def = sb_default_body_def();
    sb_region_material right;
    ndl_remesh_def remesh = ndl_default_remesh_def();
    memset(p, 0, sizeof *p);
    p->mesh = scene_box(SB_TET4, 6, 5, 5, sb_v3(REAL(0.06), REAL(0.05), REAL(0.05)), 0.1);
    p->regions = (int *)malloc((size_t)p->mesh.element_count * sizeof(int));
    for (int e = 0; e < p->mesh.element_count; e++)
        p->regions[e] = o->materials > 1 && p->mesh.nodes[p->mesh.elements[4 * (size_t)e]].x > REAL(0.03);
    p->mesh.regions = p->regions;
    right.region = 1;
    right.material = sb_material_corotated(REAL(9e4), REAL(0.4), 1300);
    def.mesh = &p->mesh;
    def.material = sb_material_corotated(REAL(5e4), REAL(0.45), 1000);
    def.region_materials = &right;
    def.region_material_count = o->materials > 1;
    def.integrator = SB_GENERALISED_ALPHA;
    def.spectral_radius = 0;
    def.max_newton = 1;
    def.damping_stiffness = REAL(0.005);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.slack = o->slack;
    def.allocator = scene_allocator(&p->memory);
    if (!CHECK_OK(sb_body_create(&def, &p->body, NULL)))
        return 0;
    for (int i = 0; i < p->mesh.node_count; i++)
        if (p->mesh.nodes[i].z < REAL(1e-6))
            CHECK_OK(sb_body_fix_nodes(p->body, &i, 1, SB_XYZ));
    remesh.body = p->body;
    remesh.max_needles = o->max_needles;
    remesh.release_above = o->release_above;
    remesh.allocator = scene_allocator(&p->memory);
    return CHECK_OK(ndl_remesh_create(&remesh, &p->remesh, NULL));
}

static void patient_destroy(patient *p)
{
    ndl_remesh_destroy(p->remesh);
    sb_body_destroy(p->body);
    CHECK_INT(p->memory.live, 0);
    p->mesh.regions = NULL;
    free(p->regions);
    sb_mesh_free(&p->mesh);
}

static void puncture(patient *p, int needle, double x, double y)
{
    ndl_surface_hit hit;
    ndl_remesh_info info;
    sb_vec3 top = sb_v3(REAL(x), REAL(y), REAL(0.08));
    if (CHECK(ndl_remesh_hit(p->remesh, top, sb_v3(top.x, top.y, 0), &hit)) &&
        CHECK_OK(ndl_remesh_puncture(p->remesh, needle, &hit, &info, NULL)))
        p->entry = info.X;
}

/* A force that swings, the tip of needle 0 from one depth to another, `steps` steps of both. */
static void drive(patient *p, int steps, double from, double to)
{
    for (int i = 0; i < steps; i++) {
        double depth = from + (to - from) * (i + 1) / steps;
        sb_vec3 X = sb_v3_madd(p->entry, REAL(-depth), sb_v3(REAL(0.2), REAL(0.1), 1));
        CHECK_OK(to >= from ? ndl_remesh_penetrate(p->remesh, 0, X, NULL, NULL)
                            : ndl_remesh_retract(p->remesh, 0, X, NULL, NULL));
        sb_vec3 force = sb_v3(REAL(0.01 * (i % 5)), REAL(0.02), 0);
        int last = p->mesh.node_count - 1;
        sb_body_clear_loads(p->body);
        CHECK_OK(sb_body_apply_forces(p->body, &last, 1, &force, 1, NULL));
        CHECK_OK(sb_body_step(p->body, REAL(0.01), NULL));
    }
}

static void rest(patient *p, int steps)
{
    for (int i = 0; i < steps; i++)
        CHECK_OK(sb_body_step(p->body, REAL(0.01), NULL));
}

/* ---- saved states ---- */

typedef struct record {
    unsigned char *bytes;
    size_t size;
} record;

static record record_of(const patient *p)
{
    record r;
    r.size = sb_body_state_size(p->body);
    r.bytes = (unsigned char *)malloc(r.size);
    CHECK_OK(sb_body_state_save(p->body, r.bytes, r.size));
    return r;
}

static void record_load(patient *p, const record *r)
{
    CHECK_OK(sb_body_state_load(p->body, r->bytes, r->size, NULL));
    CHECK_OK(ndl_remesh_check(p->remesh, NULL));
    CHECK_OK(sb_body_live_check(p->body, NULL));
}

static void record_free(record *r) { free(r->bytes); }

/* The bytes of a save are a function of the state: this compares everything that it holds. */
static int record_same(const record *a, const record *b)
{
    return a->size == b->size && memcmp(a->bytes, b->bytes, a->size) == 0;
}

static int patient_is_at(const patient *p, const record *expected)
{
    record now = record_of(p);
    int same = record_same(&now, expected);
    record_free(&now);
    return same;
}

/* ---- what follows a load ---- */

static void test_continuation(void)
{
    patient_options o = patient_default();
    patient p;
    record start, middle, end;
    if (!patient_create(&p, &o))
        return;
    rest(&p, 7);
    puncture(&p, 0, 0.024, 0.021);
    drive(&p, 12, 0, 0.012);
    start = record_of(&p);
    CHECK(patient_is_at(&p, &start)); /* saving changes nothing */
    drive(&p, 6, 0.012, 0.022);
    middle = record_of(&p);
    drive(&p, 15, 0.022, 0.008);
    rest(&p, 15);
    end = record_of(&p);
    CHECK(!record_same(&start, &end));
    for (int round = 0; round < 2; round++) { /* back from fewer splits, and from more */
        record_load(&p, &start);
        CHECK(patient_is_at(&p, &start));
        drive(&p, 6, 0.012, 0.022);
        CHECK(patient_is_at(&p, &middle));
        if (round == 0) {
            drive(&p, 15, 0.022, 0.008);
            rest(&p, 15);
            CHECK(patient_is_at(&p, &end));
        }
    }
    record_load(&p, &end); /* and forward */
    rest(&p, 3);
    record_load(&p, &middle);
    drive(&p, 15, 0.022, 0.008);
    rest(&p, 15);
    CHECK(patient_is_at(&p, &end));
    record_free(&start), record_free(&middle), record_free(&end);
    patient_destroy(&p);
}

/* Out of the needle's tissue into the original one, and back in: everything is other, nodes and tets come and go. */
static void test_withdrawn(void)
{
    patient_options o = patient_default();
    patient p;
    record fresh, in, deep, out;
    sb_vec3 entry;
    if (!patient_create(&p, &o))
        return;
    rest(&p, 4);
    fresh = record_of(&p);
    puncture(&p, 0, 0.031, 0.026);
    entry = p.entry;
    drive(&p, 8, 0, 0.015);
    in = record_of(&p);
    puncture(&p, 1, 0.012, 0.012);
    rest(&p, 3);
    p.entry = entry;
    drive(&p, 8, 0.015, 0.03);
    deep = record_of(&p);
    CHECK_OK(ndl_remesh_withdraw(p.remesh, 0, NULL, NULL));
    CHECK_OK(ndl_remesh_withdraw(p.remesh, 1, NULL, NULL));
    rest(&p, 12);
    out = record_of(&p);
    record_load(&p, &fresh);
    CHECK(ndl_remesh_is_original(p.remesh));
    puncture(&p, 0, 0.031, 0.026);
    drive(&p, 8, 0, 0.015);
    CHECK(patient_is_at(&p, &in));
    record_load(&p, &deep);
    CHECK_OK(ndl_remesh_withdraw(p.remesh, 0, NULL, NULL));
    CHECK_OK(ndl_remesh_withdraw(p.remesh, 1, NULL, NULL));
    rest(&p, 12);
    CHECK(patient_is_at(&p, &out));
    record_free(&fresh), record_free(&in), record_free(&deep), record_free(&out);
    patient_destroy(&p);
}

/* Without slack nearly every split makes room; the other patient is new and has none either. */
static void test_growth(void)
{
    patient_options o = patient_default();
    patient p, other;
    record start, end;
    o.slack = REAL(0.001);
    if (!patient_create(&p, &o) || !patient_create(&other, &o))
        return;
    rest(&p, 3);
    start = record_of(&p);
    puncture(&p, 0, 0.024, 0.021);
    drive(&p, 20, 0, 0.03);
    end = record_of(&p);
    record_load(&p, &start);
    CHECK(patient_is_at(&p, &start));
    puncture(&p, 0, 0.024, 0.021);
    drive(&p, 20, 0, 0.03);
    CHECK(patient_is_at(&p, &end));
    record_load(&other, &end); /* another process */
    other.entry = p.entry;
    drive(&p, 5, 0.03, 0.02);
    drive(&other, 5, 0.03, 0.02);
    record_free(&end);
    end = record_of(&p);
    CHECK(patient_is_at(&other, &end));
    record_free(&start), record_free(&end);
    patient_destroy(&p);
    patient_destroy(&other);
}

/* ---- refusals ---- */

/* Where the remesher's part of a saved body begins: its name is in front of it. */
static size_t part_at(const record *r)
{
    size_t at = r->size > 8 ? r->size - 8 : 0;
    while (at > 0 && memcmp(r->bytes + at, "mesher\0", 8) != 0)
        at--;
    return at;
}

/* Sealed images with wrong values: refused, with a word and with nothing changed, or, where the value may be so, taken;
 * never anything worse. */
static void test_forgeries(void)
{
    patient_options o = patient_default();
    patient p;
    record saved;
    unsigned char *copy;
    unsigned long long seed = 11;
    size_t part;
    int refused = 0, tries = check_quick() ? 200 : 2000;
    if (!patient_create(&p, &o))
        return;
    rest(&p, 2);
    puncture(&p, 0, 0.024, 0.021);
    drive(&p, 4, 0, 0.012);
    saved = record_of(&p);
    part = part_at(&saved);
    CHECK(part > 0);
    copy = (unsigned char *)malloc(saved.size);
    memcpy(copy, saved.bytes, saved.size);
    image_seal(copy, saved.size);
    CHECK(memcmp(copy, saved.bytes, saved.size) == 0);
    for (int i = 0; i < tries; i++) {
        size_t span = i % 2 ? 120 : saved.size - 8 - part;
        size_t at = part + (size_t)check_random_in(&seed, 0, (double)span);
        sb_error error;
        memcpy(copy, saved.bytes, saved.size);
        copy[at] = (unsigned char)(copy[at] ^ (1 << (i / 2) % 8));
        image_seal(copy, saved.size);
        error.message[0] = 0;
        if (sb_body_state_load(p.body, copy, saved.size, &error) != SB_OK) {
            refused++;
            CHECK(error.message[0] && patient_is_at(&p, &saved));
        } else {
            CHECK_OK(ndl_remesh_check(p.remesh, NULL));
            drive(&p, 1, 0.012, 0.0125);
            CHECK_OK(sb_body_state_load(p.body, saved.bytes, saved.size, NULL));
        }
    }
    CHECK(refused > tries / 4); /* half of them are in the head, of which most values may not be others */
    CHECK(patient_is_at(&p, &saved));
    free(copy);
    record_free(&saved);
    patient_destroy(&p);
}

/* Another's: other materials, other needles or rules, a body without remesher, a second remesher. */
static void test_foreign(void)
{
    patient_options o = patient_default(), other[3];
    ndl_remesh_def second = ndl_default_remesh_def();
    ndl_remesh *remesh = NULL;
    sb_error error;
    patient p, q;
    record saved;
    for (int i = 0; i < 3; i++)
        other[i] = o;
    other[0].materials = 1;
    other[1].max_needles = 3;
    other[2].release_above = REAL(0.5);
    if (!patient_create(&p, &o))
        return;
    puncture(&p, 0, 0.024, 0.021);
    drive(&p, 4, 0, 0.012);
    saved = record_of(&p);
    for (int i = 0; i < 3; i++)
        if (patient_create(&q, other + i)) {
            record now;
            puncture(&q, 0, 0.021, 0.024);
            now = record_of(&q);
            CHECK_RESULT(sb_body_state_load(q.body, saved.bytes, saved.size, &error),
                         i ? SB_ERROR_STATE : SB_ERROR_FORMAT);
            CHECK(error.message[0] && patient_is_at(&q, &now));
            CHECK_OK(ndl_remesh_check(q.remesh, NULL));
            record_free(&now);
            patient_destroy(&q);
        }
    second.body = p.body;
    CHECK_RESULT(ndl_remesh_create(&second, &remesh, &error), SB_ERROR_ARGUMENT);
    CHECK(remesh == NULL && strstr(error.message, "remesher"));
    if (patient_create(&q, &o)) {
        ndl_remesh_destroy(q.remesh);
        q.remesh = NULL;
        CHECK_RESULT(sb_body_state_load(q.body, saved.bytes, saved.size, &error), SB_ERROR_STATE);
        CHECK(strstr(error.message, "mesher"));
        patient_destroy(&q);
    }
    record_free(&saved);
    patient_destroy(&p);
}

/* Every allocation of a load into a patient without room fails in turn, and nothing changes; in the end it succeeds. */
static void test_memory(void)
{
    patient_options o = patient_default();
    patient p;
    record saved;
    int done = 0, fail;
    o.slack = REAL(0.001);
    if (!patient_create(&p, &o))
        return;
    rest(&p, 2);
    puncture(&p, 0, 0.021, 0.019); /* where it takes a split: the load needs more room than there is */
    drive(&p, 12, 0, 0.03);
    saved = record_of(&p);
    for (fail = 1; !done && fail < 400; fail++) {
        patient q;
        record now;
        sb_result result;
        if (!patient_create(&q, &o))
            break;
        puncture(&q, 0, 0.024, 0.021);
        now = record_of(&q);
        q.memory.fail_at = q.memory.calls + fail;
        result = sb_body_state_load(q.body, saved.bytes, saved.size, NULL);
        q.memory.fail_at = 0;
        done = result == SB_OK;
        if (!done) {
            CHECK_RESULT(result, SB_ERROR_MEMORY);
            CHECK(patient_is_at(&q, &now));
            CHECK_OK(ndl_remesh_check(q.remesh, NULL));
            record_load(&q, &saved);
        }
        CHECK(patient_is_at(&q, &saved));
        record_free(&now);
        patient_destroy(&q);
    }
    CHECK(done && fail > 8);
    record_free(&saved);
    patient_destroy(&p);
}

/* ---- recordings ---- */

/* Calls of a remesher replay on a body with one, failed ones too; on one without they are refused by name. */
static void test_recording(void)
{
    patient_options o = patient_default();
    patient p, q;
    sb_recording *recording = NULL;
    sb_recording_report report;
    sb_vec3 entry;
    record end;
    if (!patient_create(&p, &o) || !patient_create(&q, &o))
        return;
    rest(&p, 2);
    puncture(&p, 0, 0.031, 0.026);
    entry = p.entry;
    drive(&p, 3, 0, 0.008);
    CHECK_OK(sb_recording_start(p.body, 1, NULL, &recording, NULL)); /* in mid-insertion */
    drive(&p, 6, 0.008, 0.02);
    puncture(&p, 1, 0.012, 0.012);
    CHECK_RESULT(ndl_remesh_retract(p.remesh, 7, entry, NULL, NULL), SB_ERROR_INDEX);
    p.entry = entry;
    drive(&p, 4, 0.02, 0.012);
    CHECK_OK(ndl_remesh_withdraw(p.remesh, 0, NULL, NULL));
    rest(&p, 3);
    sb_recording_stop(recording);
    end = record_of(&p);
    rest(&p, 2);
    if (!CHECK_OK(sb_recording_replay(recording, q.body, &report)))
        printf("step %d, nodes %d to %d: %s\n", report.step, report.first_node, report.last_node, report.error.message);
    CHECK(patient_is_at(&q, &end));
    CHECK_OK(ndl_remesh_check(q.remesh, NULL));
    CHECK_OK(sb_recording_replay(recording, p.body, &report)); /* from another state, with a needle in it */
    CHECK(patient_is_at(&p, &end));
    ndl_remesh_destroy(q.remesh);
    q.remesh = NULL;
    CHECK_RESULT(sb_recording_replay(recording, q.body, &report), SB_ERROR_STATE);
    CHECK(strstr(report.error.message, "mesher"));
    record_free(&end);
    sb_recording_destroy(recording);
    patient_destroy(&p);
    patient_destroy(&q);
}

/* ---- rods ---- */

static ndl_rod *make_rod(int capacity, ndl_rod_rest rest)
{
    sb_vec3 nodes[9];
    ndl_rod_def def = ndl_default_rod_def();
    ndl_rod *rod = NULL;
    for (int i = 0; i < 9; i++)
        nodes[i] = sb_v3(REAL(0.02 * i), REAL(0.0006 * i * i), REAL(0.0002 * i));
    def.nodes = nodes;
    def.node_count = 9;
    def.capacity = capacity;
    def.rest = rest;
    def.gravity = sb_v3(0, REAL(-9.81), 0);
    CHECK_OK(ndl_rod_create(&def, &rod, NULL));
    return rod;
}

static void drive_rod(ndl_rod *rod, int steps)
{
    for (int i = 0; i < steps; i++) {
        CHECK_OK(ndl_rod_turn(rod, 0, REAL(0.03)));
        CHECK_OK(ndl_rod_set_force(rod, 3, sb_v3(0, REAL(0.01 * (i % 3)), REAL(0.02))));
        CHECK_OK(ndl_rod_step(rod, REAL(0.002), NULL));
        if (i % 4 == 1)
            CHECK_OK(ndl_rod_split_edge(rod, 3));
        if (i % 4 == 3)
            CHECK_OK(ndl_rod_merge_node(rod, 4));
    }
}

static void *rod_record(const ndl_rod *rod, size_t *size)
{
    void *bytes = malloc(*size = ndl_rod_state_size(rod));
    CHECK_OK(ndl_rod_save(rod, bytes, *size, NULL));
    return bytes;
}

static int rod_is_at(const ndl_rod *rod, const void *bytes, size_t size)
{
    size_t own;
    void *now = rod_record(rod, &own);
    int same = own == size && memcmp(now, bytes, size) == 0;
    free(now);
    return same;
}

static void test_rod(void)
{
    ndl_rod *rod = make_rod(16, NDL_REST_SHAPE), *other = make_rod(12, NDL_REST_SHAPE);
    size_t size, end_size;
    void *start, *end;
    sb_vec3 tip;
    drive_rod(rod, 6);
    start = rod_record(rod, &size);
    CHECK(rod_is_at(rod, start, size));
    drive_rod(rod, 9);
    end = rod_record(rod, &end_size);
    tip = ndl_rod_positions(rod)[ndl_rod_node_count(rod) - 1];
    for (int i = 0; i < 2; i++) {
        ndl_rod *into = i ? other : rod;
        CHECK_OK(ndl_rod_load(into, start, size, NULL));
        CHECK(rod_is_at(into, start, size));
        drive_rod(into, 9);
        CHECK(rod_is_at(into, end, end_size));
        CHECK(memcmp(&tip, &ndl_rod_positions(into)[ndl_rod_node_count(into) - 1], sizeof tip) == 0);
    }
    free(start);
    free(end);
    ndl_rod_destroy(rod);
    ndl_rod_destroy(other);
}

static void test_rod_refusals(void)
{
    ndl_rod *rod = make_rod(16, NDL_REST_SHAPE), *small = make_rod(9, NDL_REST_SHAPE);
    size_t size, now_size;
    unsigned char *saved, *now;
    drive_rod(rod, 2);
    saved = (unsigned char *)rod_record(rod, &size);
    drive_rod(rod, 4);
    now = (unsigned char *)rod_record(rod, &now_size);
    CHECK_RESULT(ndl_rod_load(small, saved, size, NULL), SB_ERROR_STATE); /* 10 nodes */
    CHECK_RESULT(ndl_rod_load(NULL, saved, size, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_load(rod, NULL, size, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_save(rod, saved, 10, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_rod_save(NULL, saved, size, NULL), SB_ERROR_ARGUMENT);
    CHECK_INT(ndl_rod_state_size(NULL), 0);
    for (size_t at = 0; at < size; at++) {
        saved[at] = (unsigned char)(saved[at] ^ 4);
        CHECK(ndl_rod_load(rod, saved, size, NULL) != SB_OK);
        image_seal(saved, size); /* the wrong value alone: whatever comes of it, it is a rod */
        ndl_rod_load(rod, saved, size, NULL);
        saved[at] = (unsigned char)(saved[at] ^ 4);
        image_seal(saved, size);
        CHECK_RESULT(ndl_rod_load(rod, saved, at, NULL), SB_ERROR_FORMAT);
    }
    CHECK_OK(ndl_rod_load(rod, now, now_size, NULL));
    CHECK(rod_is_at(rod, now, now_size));
    free(saved);
    free(now);
    ndl_rod_destroy(rod);
    ndl_rod_destroy(small);
}

CHECK_SUITE(ndl_state, {"continuation after loads with remeshing in between", test_continuation},
            {"in and out of tissue, two needles", test_withdrawn}, {"growth, and another body", test_growth},
            {"sealed images with wrong values", test_forgeries}, {"another's state", test_foreign},
            {"every allocation failing", test_memory}, {"recordings of a remesher's calls", test_recording},
            {"rod continues", test_rod}, {"rod refusals", test_rod_refusals});
