/* test_contact_state: contact gives the same bits whatever the threads, goes on from a saved state and from a recording
 * as if nothing had been, takes steps that fail back, and allocates nothing while it steps. */
#define SB_SPLIT_BUILD
#include "../src/softbody/contact/contact_private.h"

#include "contact_scene.h"
#include "image.h"

/* A slab with a sphere that slides on it, a bent chain that lies on it, and a box that presses its side; the last two
 * hang on springs. */
typedef struct play {
    press p;
    int tools[3], workers;
} play;

static void play_make(play *s, sb_element_type type, int workers, sb_material material, const sb_allocator *allocator)
{
    const sb_vec3 chain[3] = {
        {REAL(-0.02), 0, REAL(0.001)}, {0, REAL(0.002), 0}, {REAL(0.02), REAL(0.001), REAL(0.001)}};
    sb_body_def def = sb_default_body_def();
    sb_tool_def defs[3];
    int cells = type == SB_TET10 ? 1 : 2;
    s->workers = workers;
    def.material = material;
    def.damping_stiffness = REAL(0.01);
    def.jobs = scene_jobs(&s->workers);
    if (allocator)
        def.allocator = *allocator;
    s->p = press_make(scene_box(type, 4 * cells, 3 * cells, cells, sb_v3(REAL(0.08), REAL(0.06), REAL(0.02)), 0.1), def,
                      sb_default_contact_def());
    scene_fix_plane(s->p.body, &s->p.mesh, 2, 0, SB_XYZ);
    defs[0] = press_sphere(0.008, 0.4, sb_v3(REAL(0.02), REAL(0.03), REAL(0.0285)));
    defs[1] = press_sphere(0.004, 0.2, sb_v3(REAL(0.05), REAL(0.015), REAL(0.0245)));
    defs[1].shape = SB_TOOL_CAPSULES;
    defs[1].points = chain;
    defs[1].point_count = 3;
    defs[2] =
        press_box(sb_v3(REAL(0.005), REAL(0.01), REAL(0.01)), 0.004, 0.5, sb_v3(REAL(0.086), REAL(0.035), REAL(0.012)));
    defs[2].coupling_stiffness = REAL(200); /* both kinds of springs */
    defs[2].coupling_turning = REAL(0.02);
    defs[1].coupling_stiffness = REAL(1000);
    for (int t = 0; t < 3; t++)
        s->tools[t] = press_add(&s->p, defs + t);
}

/* Step number i: the sphere slides and turns, the chain goes down and bends, the box comes. */
static sb_result play_step(play *s, int i)
{
    double at = i * 0.001;
    sb_vec3 chain[3] = {{REAL(-0.02), 0, REAL(0.001)}, {0, REAL(0.002), 0}, {REAL(0.02), REAL(0.001), REAL(0.001)}};
    chain[1].z = REAL(-0.0001 * (i < 20 ? i : 20));
    press_move(&s->p, s->tools[0], sb_v3(REAL(0.02 + 0.5 * at), REAL(0.03), REAL(i < 10 ? 0.0285 - 0.3 * at : 0.0255)),
               sb_quat_from_rotation_vector(sb_v3(0, REAL(10 * at), 0)));
    press_move(&s->p, s->tools[1], sb_v3(REAL(0.05), REAL(0.015), REAL(i < 20 ? 0.0245 - 0.1 * at : 0.0225)),
               sb_quat_identity());
    CHECK_OK(sb_contact_bend_tool(s->p.contact, s->tools[1], chain));
    press_move(&s->p, s->tools[2], sb_v3(REAL(i < 20 ? 0.086 - 0.2 * at : 0.082), REAL(0.035), REAL(0.012)),
               sb_quat_identity());
    return sb_body_step(s->p.body, REAL(0.01), NULL);
}

static void play_steps(play *s, int from, int to)
{
    for (int i = from; i < to; i++)
        CHECK_OK(play_step(s, i));
}

static sb_material play_material(void) { return sb_material_corotated(REAL(5e3), REAL(0.45), 1000); }

static uint64_t play_hash(const play *s)
{
    uint64_t hash = sb_body_state_hash(s->p.body);
    for (int t = 0; t < 3; t++) {
        sb_wrench wrench = press_wrench(&s->p, s->tools[t]);
        CHECK(sb_v3_norm(wrench.force) > 0);
        hash ^= scene_hash(&wrench, sizeof wrench) << t;
    }
    return hash;
}

static void test_threads(void)
{
    const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8};
    const int workers[] = {1, 3, 16, 2, 8};
    for (int k = 0; k < 3; k++) {
        uint64_t first = 0;
        for (int w = 0; w < (check_quick() ? 2 : 5); w++) {
            play s;
            play_make(&s, types[k], workers[w], play_material(), NULL);
            play_steps(&s, 0, 25);
            if (w == 0)
                first = play_hash(&s);
            CHECK(play_hash(&s) == first);
            press_free(&s.p);
        }
    }
}

static void test_saved(void)
{
    play s, other;
    size_t size;
    void *image;
    uint64_t end;
    play_make(&s, SB_TET4, 1, play_material(), NULL);
    play_make(&other, SB_TET4, 2, play_material(), NULL);
    play_steps(&s, 0, 25);
    size = sb_body_state_size(s.p.body);
    image = malloc(size);
    CHECK_OK(sb_body_state_save(s.p.body, image, size));
    play_steps(&other, 0, 3); /* anything */
    CHECK_OK(sb_body_state_load(other.p.body, image, size, NULL));
    CHECK(play_hash(&other) == play_hash(&s));
    play_steps(&s, 25, 40);
    play_steps(&other, 25, 40);
    end = play_hash(&s);
    CHECK(play_hash(&other) == end);
    CHECK_OK(sb_body_state_load(s.p.body, image, size, NULL));
    play_steps(&s, 25, 40);
    CHECK(play_hash(&s) == end);
    free(image);
    press_free(&s.p);
    press_free(&other.p);
}

static void test_recorded(void)
{
    play s, other;
    sb_recording *recording = NULL;
    sb_recording_report report;
    play_make(&s, SB_TET4, 1, play_material(), NULL);
    play_make(&other, SB_TET4, 3, play_material(), NULL);
    play_steps(&s, 0, 10);
    CHECK_OK(sb_recording_start(s.p.body, 1, NULL, &recording, NULL));
    play_steps(&s, 10, 25);
    CHECK_OK(sb_contact_set_friction(s.p.contact, s.tools[0], REAL(0.1)));
    play_steps(&s, 25, 30);
    sb_recording_stop(recording);
    if (!CHECK_OK(sb_recording_replay(recording, other.p.body, &report)))
        printf("step %d: %s\n", report.step, report.error.message);
    CHECK_INT(report.steps, 20);
    CHECK(play_hash(&other) == play_hash(&s));
    sb_recording_destroy(recording);
    press_free(&s.p);
    press_free(&other.p);
}

/* Words of the state of a contact, changed to what breaks things: refused, or taken and sound. */
static void test_forged(void)
{
    const uint32_t values[6] = {0xFFFFFFFFu, 0x7FFFFFFFu, 0x80000000u, 0, 0x7FF00000u, 100};
    play s;
    size_t size, without, stride = check_quick() ? 101 : 13;
    unsigned char *image, *copy;
    int refused = 0, taken = 0;
    check_bad_numbers();
    play_make(&s, SB_TET4, 1, play_material(), NULL);
    play_steps(&s, 0, 15);
    size = sb_body_state_size(s.p.body);
    image = (unsigned char *)malloc(size);
    copy = (unsigned char *)malloc(size);
    CHECK_OK(sb_body_state_save(s.p.body, image, size));
    for (without = size - 8; without > 7 && memcmp(image + without - 7, "contact", 7) != 0; without--)
        ;
    CHECK(without > 7);
    for (size_t at = without; at + 12 <= size; at += 4)
        for (size_t k = at < without + 400 || (at / 4) % stride == 0 ? 0 : 6; k < 6; k++) {
            memcpy(copy, image, size);
            image_put(copy + at, values[k], 4);
            if (memcmp(copy, image, size) == 0)
                continue;
            image_seal(copy, size);
            if (sb_body_state_load(s.p.body, copy, size, NULL) != SB_OK) {
                refused++;
                continue;
            }
            taken++;
            if (taken % 8 == 0)
                (void)sb_body_step(s.p.body, REAL(0.01), NULL);
            CHECK_OK(sb_body_state_load(s.p.body, image, size, NULL));
        }
    CHECK(refused > 100 && taken > 100);
    CHECK_OK(play_step(&s, 15));
    free(copy);
    free(image);
    press_free(&s.p);
}

/* A step that fails leaves all as it was, contact too. */
static void test_undo(void)
{
    play s, other;
    sb_vec3 inside_out = sb_v3(0, 0, REAL(0.5)), home = sb_v3(0, 0, 0);
    sb_material material = sb_material_neo_hookean(REAL(5e3), REAL(0.4), 1000);
    sb_wrench before, after;
    uint64_t hash;
    play_make(&s, SB_TET4, 1, material, NULL);
    play_make(&other, SB_TET4, 1, material, NULL);
    play_steps(&s, 0, 15);
    play_steps(&other, 0, 15);
    for (int i = 0; i < s.p.mesh.node_count; i += 2)
        if (s.p.mesh.nodes[i].z < REAL(1e-6))
            CHECK_OK(sb_body_prescribe(s.p.body, &i, 1, SB_XYZ, &inside_out, 1));
    before = press_wrench(&s.p, s.tools[0]);
    hash = sb_body_state_hash(s.p.body);
    CHECK(sb_body_step(s.p.body, REAL(0.01), NULL) != SB_OK);
    CHECK(sb_body_state_hash(s.p.body) == hash);
    after = press_wrench(&s.p, s.tools[0]);
    CHECK(memcmp(&before, &after, sizeof before) == 0);
    for (int i = 0; i < s.p.mesh.node_count; i += 2)
        if (s.p.mesh.nodes[i].z < REAL(1e-6))
            CHECK_OK(sb_body_prescribe(s.p.body, &i, 1, SB_XYZ, &home, 1));
    play_steps(&s, 15, 25);
    play_steps(&other, 15, 25);
    CHECK(memcmp(sb_body_positions(s.p.body), sb_body_positions(other.p.body),
                 (size_t)s.p.mesh.node_count * sizeof(sb_vec3)) == 0);
    press_free(&s.p);
    press_free(&other.p);
}

/* ---- memory ---- */

/* Two jaws grip the play's slab where nothing else touches it. */
static void play_grip(play *s, int jaws[2])
{
    for (int j = 0; j < 2; j++) {
        double y = j == 0 ? -0.0085 : 0.0685;
        sb_tool_def jaw =
            press_box(sb_v3(REAL(0.006), REAL(0.008), REAL(0.007)), 0.004, 0.5, sb_v3(REAL(0.06), REAL(y), REAL(0.01)));
        jaws[j] = press_add(&s->p, &jaw);
    }
}

static void test_no_allocation(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    play s;
    int calls, jaws[2];
    play_make(&s, SB_TET4, 1, play_material(), &allocator);
    play_grip(&s, jaws);
    play_steps(&s, 0, 1);
    calls = memory.calls;
    for (int i = 1; i < (check_quick() ? 100 : 1000); i++) {
        double closed = 0.0001 * (i < 20 ? i : 20), pulled = i < 20 ? 0 : 1e-5 * (i < 120 ? i - 20 : 100);
        press_move(&s.p, jaws[0], sb_v3(REAL(0.06), REAL(-0.0085 + closed), REAL(0.01 + pulled)), sb_quat_identity());
        press_move(&s.p, jaws[1], sb_v3(REAL(0.06), REAL(0.0685 - closed), REAL(0.01 + pulled)), sb_quat_identity());
        CHECK_OK(play_step(&s, i));
    }
    CHECK(press_wrench(&s.p, jaws[0]).force.y < 0 && press_wrench(&s.p, jaws[1]).force.y > 0);
    CHECK_INT(memory.calls, calls);
    press_free(&s.p);
    CHECK_INT(memory.live, 0);
}

/* Each allocation of a contact and its tools fails in turn, and nothing is left behind. */
static void test_no_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    const sb_vec3 chain[2] = {{0, 0, 0}, {REAL(0.02), 0, 0}};
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact_def = sb_default_contact_def();
    sb_tool_def tool = press_sphere(0.004, 0, sb_v3(0, 0, 1));
    sb_mesh mesh = scene_box(SB_TET4, 2, 2, 2, sb_v3(REAL(0.02), REAL(0.02), REAL(0.02)), 0);
    sb_contact *contact = NULL;
    sb_body *body;
    sb_result result = SB_ERROR_MEMORY;
    int live, number = -1, fails = 0;
    def.mesh = &mesh;
    def.material = play_material();
    def.allocator = allocator;
    body = scene_body(&def);
    contact_def.body = body;
    live = memory.live; /* the body may keep its list of parts besides */
    for (; result != SB_OK && fails < 100; fails++) {
        memory.calls = 0;
        memory.fail_at = fails + 1;
        result = sb_contact_create(&contact_def, &contact, NULL);
        CHECK(result == SB_OK || (result == SB_ERROR_MEMORY && memory.live <= live + 1 && !contact));
    }
    CHECK(fails > 4 && result == SB_OK);
    tool.shape = SB_TOOL_CAPSULES;
    tool.points = chain;
    tool.point_count = 2;
    live = memory.live;
    for (result = SB_ERROR_MEMORY, fails = 0; result != SB_OK && fails < 100; fails++) {
        memory.calls = 0;
        memory.fail_at = fails + 1;
        result = sb_contact_add_tool(contact, &tool, &number, NULL);
        CHECK(result == SB_OK || (result == SB_ERROR_MEMORY && memory.live == live && number == -1));
    }
    CHECK(fails > 2 && number == 0);
    memory.fail_at = 0;
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    sb_contact_destroy(contact);
    sb_body_destroy(body);
    CHECK_INT(memory.live, 0);
    sb_mesh_free(&mesh);
}

/* Two tools press on the same faces, and a change of the mesh has left one entry: corners of its face remember both. */
static void test_shared_face(void)
{
    sb_tool_def sphere = press_sphere(0.008, 0.4, sb_v3(REAL(0.04), REAL(0.03), REAL(0.0275)));
    sb_body_def def = sb_default_body_def();
    sb_contact *contact;
    const int *nodes;
    press p;
    uint64_t hash;
    size_t size;
    void *image;
    int count = 0;
    def.material = play_material();
    p = press_make(scene_box(SB_TET4, 8, 6, 2, sb_v3(REAL(0.08), REAL(0.06), REAL(0.02)), 0.1), def,
                   sb_default_contact_def());
    contact = p.contact;
    scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    CHECK_INT(press_add(&p, &sphere), 0);
    sphere.pose.position.x += REAL(0.0005);
    CHECK_INT(press_add(&p, &sphere), 1);
    for (int i = 0; i < 4; i++)
        CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
    CHECK(contact->entry_count > 10);
    contact->entries[0] = contact->entries[contact->entry_count / 4];
    contact->entry_count = 1;
    nodes = sbi_contact_face_nodes(contact->faces, contact->entries[0].face);
    for (int i = 0; i < contact->pressure_count; i++)
        for (int a = 0; a < 3; a++)
            if (contact->pressures[i].node == nodes[a])
                contact->pressures[count++] = contact->pressures[i];
    contact->pressure_count = count;
    CHECK(count > contact->corner_room);
    hash = sb_body_state_hash(p.body);
    size = sb_body_state_size(p.body);
    image = malloc(size);
    CHECK_OK(sb_body_state_save(p.body, image, size));
    CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
    CHECK_OK(sb_body_state_load(p.body, image, size, NULL));
    CHECK(sb_body_state_hash(p.body) == hash);
    CHECK_INT(contact->pressure_count, count);
    free(image);
    press_free(&p);
}

CHECK_SUITE(contact_state, {"threads", test_threads}, {"saved and loaded", test_saved}, {"recorded", test_recorded},
            {"forged", test_forged}, {"undo", test_undo}, {"no allocation", test_no_allocation},
            {"no memory", test_no_memory}, {"a face of two tools", test_shared_face});
