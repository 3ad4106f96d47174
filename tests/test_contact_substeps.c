/* test_contact_substeps: steps in which tissue flies past a tool, or is squeezed without room, are divided or tools
 * give way: they succeed, and where nothing helps all is as it was. */
#define SB_SPLIT_BUILD
#include "../src/softbody/contact/contact_private.h"

#include "contact_scene.h"

static sb_body_def soft_def(void)
{
    sb_body_def def = sb_default_body_def();
    def.material = sb_material_corotated(REAL(5e3), REAL(0.4), 1000);
    def.damping_stiffness = REAL(0.005);
    return def;
}

static void throw_body(press *p)
{
    sb_vec3 *v = (sb_vec3 *)calloc((size_t)p->mesh.node_count, sizeof *v);
    for (int i = 0; i < p->mesh.node_count; i++)
        v[i].z = -3;
    CHECK_OK(sb_body_set_velocities(p->body, v));
    free(v);
}

/* A free cube that flies at a small sphere, which stays, at 3 m/s: 50 mm in a step of 60 Hz. */
static press flying(sb_integrator integrator)
{
    sb_body_def def = soft_def();
    sb_tool_def tool = press_sphere(0.006, 0.2, sb_v3(REAL(0.011), REAL(0.009), REAL(-0.03)));
    press p;
    def.integrator = integrator;
    p = press_make(scene_box(SB_TET4, 3, 3, 3, sb_v3(REAL(0.02), REAL(0.02), REAL(0.02)), 0.2), def,
                   sb_default_contact_def());
    CHECK_INT(press_add(&p, &tool), 0);
    throw_body(&p);
    return p;
}

/* Mean velocity of the nodes. */
static double falls(const press *p)
{
    double sum = 0;
    for (int i = 0; i < p->mesh.node_count; i++)
        sum += (double)sb_body_velocities(p->body)[i].z;
    return sum / p->mesh.node_count;
}

/* Least height of the body's nodes. */
static double lowest(const press *p)
{
    double least = HUGE_VAL;
    for (int i = 0; i < p->mesh.node_count; i++)
        least = fmin(least, (double)sb_body_positions(p->body)[i].z);
    return least;
}

static int same_places(const press *a, const press *b)
{
    size_t size = (size_t)a->mesh.node_count * sizeof(sb_vec3);
    return memcmp(sb_body_positions(a->body), sb_body_positions(b->body), size) == 0 &&
           memcmp(sb_body_velocities(a->body), sb_body_velocities(b->body), size) == 0;
}

enum { MOST_PARTS = 16 };

/* Lengths of the parts that a step has taken (s). */
static sb_result (*own_begin)(void *, const sbi_touch_step *, sb_error *);
static void (*own_commit)(void *);
static sb_real begun, taken[MOST_PARTS];
static int taken_count;

static sb_result noting_begin(void *contact, const sbi_touch_step *step, sb_error *error)
{
    begun = step->dt;
    return own_begin(contact, step, error);
}

static void noting_commit(void *contact)
{
    if (CHECK(taken_count < MOST_PARTS))
        taken[taken_count++] = begun;
    own_commit(contact);
}

static void note_parts(const press *p)
{
    own_begin = p->contact->touch.begin;
    own_commit = p->contact->touch.commit;
    p->contact->touch.begin = noting_begin;
    p->contact->touch.commit = noting_commit;
}

/* 1: both tell the same stiffness of their tool, which is not 0. */
static int same_stiffness(const press *a, const press *b)
{
    sb_real k[6][6], other[6][6];
    CHECK_OK(sb_contact_stiffness(a->contact, 0, k));
    CHECK_OK(sb_contact_stiffness(b->contact, 0, other));
    return memcmp(k, other, sizeof k) == 0 && k[2][2] != 0;
}

/* A divided step is what steps of its parts' lengths are, and lets nothing through; stiffness is told of the last. */
static void test_flying(void)
{
    const sb_integrator integrators[] = {SB_EULER, SB_GENERALISED_ALPHA, SB_NEWMARK};
    const sb_real dt = REAL(1.0 / 60);
    for (int k = 0; k < 3; k++) {
        press p = flying(integrators[k]), by_hand = flying(integrators[k]);
        int divided = 0, stiff = 0;
        note_parts(&p);
        for (int i = 0; i < 30; i++) {
            sb_step_info info;
            taken_count = 0;
            CHECK_OK(sb_body_step(p.body, dt, &info));
            divided += info.substeps > 0;
            CHECK_INT(taken_count, info.substeps ? info.substeps : 1);
            for (int part = 0; part < taken_count; part++) {
                CHECK(part == 0 || taken[part] <= taken[part - 1]);
                CHECK_OK(sb_body_step(by_hand.body, taken[part], NULL));
            }
            CHECK(same_places(&p, &by_hand));
            stiff += taken_count > 1 && same_stiffness(&p, &by_hand);
        }
        CHECK(divided > 0);
        CHECK_INT(stiff, divided);
        CHECK(falls(&p) > -2); /* it was stopped, some of it at least */
        press_free(&p);
        press_free(&by_hand);
    }
}

/* Supports reach their targets at the end of a divided step, evenly on the way. */
static void test_supports(void)
{
    press p;
    sb_step_info info;
    sb_tool_def tool = press_sphere(0.006, 0, sb_v3(REAL(0.02), REAL(0.02), REAL(-0.0062)));
    sb_vec3 goal = sb_v3(0, REAL(0.003), REAL(-0.008));
    int divided = 0;
    p = press_make(scene_box(SB_TET4, 4, 4, 2, sb_v3(REAL(0.04), REAL(0.04), REAL(0.02)), 0.1), soft_def(),
                   sb_default_contact_def());
    scene_fix_plane(p.body, &p.mesh, 2, 0.02, SB_XYZ);
    CHECK_INT(press_add(&p, &tool), 0);
    for (int i = 0; i < 6; i++) {
        sb_vec3 at = sb_v3_scale((sb_real)(i + 1), goal);
        at.z = i < 3 ? at.z : REAL(-0.024);
        for (int n = 0; n < p.mesh.node_count; n++)
            if (p.mesh.nodes[n].z > REAL(0.0199))
                CHECK_OK(sb_body_prescribe(p.body, &n, 1, SB_XYZ, &at, 1));
        CHECK_OK(sb_body_step(p.body, REAL(0.01), &info));
        divided += info.substeps > 0;
        for (int n = 0; n < p.mesh.node_count; n++)
            if (p.mesh.nodes[n].z > REAL(0.0199)) {
                sb_vec3 place = sb_v3_add(p.mesh.nodes[n], at);
                CHECK(sb_v3_norm(sb_v3_sub(place, sb_body_positions(p.body)[n])) < REAL(1e-6));
            }
    }
    CHECK(divided > 0);
    press_free(&p);
}

/* ---- what nobody chose ---- */

/* A body of any element, size, stiffness and material flies at a tool of any shape, which stays, with any step. */
static press random_flight(unsigned long long *seed, int iterates, double *side, double *speed, double *dt)
{
    const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8};
    int type = (int)(3 * check_random(seed)), cells = type == 1 ? 1 : 2, shape = (int)(3 * check_random(seed));
    double size = 0.02 * pow(10, check_random_in(seed, -2, 2)),
           young = 1000 * size / 0.02 * pow(10, check_random(seed));
    double x = size * check_random_in(seed, 0.2, 0.8), y = size * check_random_in(seed, 0.2, 0.8);
    sb_vec3 chain[2] = {{REAL(-0.6 * size), 0, 0}, {REAL(0.6 * size), REAL(0.2 * size), 0}};
    sb_body_def def = sb_default_body_def();
    sb_tool_def tool = press_sphere(0.25 * size, 0.3, sb_v3(REAL(x), REAL(y), REAL(-0.7 * size)));
    sb_real modulus = REAL(young), ratio = REAL(check_random_in(seed, 0, 0.45));
    press p;
    def.material = check_random(seed) < 0.5 ? sb_material_corotated(modulus, ratio, 1000)
                                            : sb_material_stable_neo_hookean(modulus, ratio, 1000);
    *side = size;
    *speed = sqrt(size / 0.02) * check_random_in(seed, 0.5, 3);
    *dt = sqrt(size / 0.02) * check_random_in(seed, 0.004, 0.03);
    def.damping_stiffness = REAL(0.2 * *dt);
    def.max_newton = iterates ? 20 : 1;
    if (shape == 1) {
        tool.shape = SB_TOOL_CAPSULES;
        tool.points = chain;
        tool.point_count = 2;
    } else if (shape == 2) {
        tool.shape = SB_TOOL_BOX;
        tool.half = sb_v3(REAL(0.4 * size), REAL(0.3 * size), REAL(0.25 * size));
        tool.radius = REAL(0.2 * size);
    }
    p = press_make(scene_box(types[type], cells, cells, cells, sb_v3(REAL(size), REAL(size), REAL(size)), 0.2), def,
                   sb_default_contact_def());
    CHECK_INT(press_add(&p, &tool), 0);
    return p;
}

static double energy_of(const press *p)
{
    sb_energy energy;
    CHECK_OK(sb_body_energy(p->body, &energy));
    return (double)(energy.kinetic + energy.elastic);
}

/* No step is refused in which the body goes less than twice its size, and one that is refused changes nothing. Where
 * steps iterate no energy comes from nowhere. (One linear system for a step in which a body turns by more than a radian
 * may make some, contact or not.) */
static void test_random_flights(void)
{
    unsigned long long seed = 31;
    int rounds = check_rounds(60), divided = 0, refused = 0;
    for (int round = 0; round < rounds; round++) {
        double speed, dt, size, start;
        int iterates = round % 2;
        press p = random_flight(&seed, iterates, &size, &speed, &dt);
        sb_vec3 *v = (sb_vec3 *)calloc((size_t)p.mesh.node_count, sizeof *v);
        for (int i = 0; i < p.mesh.node_count; i++)
            v[i].z = REAL(-speed);
        CHECK_OK(sb_body_set_velocities(p.body, v));
        free(v);
        start = energy_of(&p);
        for (int i = 0; i < 20; i++) {
            sb_step_info info;
            uint64_t hash = sb_body_state_hash(p.body);
            if (sb_body_step(p.body, REAL(dt), &info) != SB_OK) {
                CHECK(info.error.message[0] && sb_body_state_hash(p.body) == hash);
                if (speed * dt < 2 * size) {
                    refused++;
                    printf("  round %d, step %d of %g s: %s\n", round, i, dt, info.error.message);
                }
                break;
            }
            divided += info.substeps > 0;
            if (iterates && !CHECK(energy_of(&p) < 1.01 * start))
                printf("  round %d, step %d: %g of %g J\n", round, i, energy_of(&p), start);
        }
        CHECK(scene_all_finite(sb_body_positions(p.body), p.mesh.node_count));
        press_free(&p);
    }
    CHECK_INT(refused, 0);
    if (rounds > 30)
        CHECK(divided > 0);
}

/* Bodies that would be far beyond the tool even in the shortest part of a step stop before it: no step is refused, none
 * comes through, and energy is only lost. */
static void test_far_too_fast(void)
{
    const sb_integrator integrators[] = {SB_EULER, SB_GENERALISED_ALPHA, SB_NEWMARK};
    for (int k = 0; k < 3; k++) {
        press p = flying(integrators[k]);
        sb_vec3 *v = (sb_vec3 *)calloc((size_t)p.mesh.node_count, sizeof *v);
        double start;
        int mended = 0;
        for (int i = 0; i < p.mesh.node_count; i++)
            v[i].z = -1000;
        CHECK_OK(sb_body_set_velocities(p.body, v));
        free(v);
        start = energy_of(&p);
        for (int i = 0; i < 5; i++) {
            sb_step_info info;
            CHECK_OK(sb_body_step(p.body, REAL(1.0 / 60), &info));
            mended += sb_contact_get_info(p.contact).mended;
            CHECK(energy_of(&p) <= start);
        }
        CHECK(mended > 0);
        CHECK(scene_all_finite(sb_body_positions(p.body), p.mesh.node_count));
        CHECK(lowest(&p) > -0.03);
        press_free(&p);
    }
}

/* ---- nothing helps ---- */

static int (*own_accept)(void *contact, const sb_vec3 *u);
static int refusals, asked;

/* Refuses all ends of steps but each third, or all. */
static int refusing_accept(void *contact, const sb_vec3 *u)
{
    asked++;
    return own_accept(contact, u) && refusals > 1 && asked % refusals == 0;
}

static void test_taken_back(void)
{
    press p = flying(SB_EULER), other = flying(SB_EULER);
    for (int i = 0; i < 12; i++) {
        sb_step_info info;
        uint64_t hash = sb_body_state_hash(p.body);
        sb_wrench before = press_wrench(&p, 0), after;
        sb_contact_info told = sb_contact_get_info(p.contact), now;
        own_accept = p.contact->touch.accept;
        p.contact->touch.accept = refusing_accept;
        refusals = i % 2 ? 1 : 9; /* of eight tries of the first part, and of those that follow, some succeed */
        asked = i;
        if (sb_body_step(p.body, REAL(0.01), &info) != SB_OK) {
            CHECK_INT(info.error.result, SB_ERROR_DIVERGED);
            CHECK_INT(info.substeps, 0);
        } else {
            CHECK_INT(refusals, 9);
        }
        p.contact->touch.accept = own_accept;
        if (info.error.result != SB_OK) {
            CHECK(sb_body_state_hash(p.body) == hash);
            after = press_wrench(&p, 0);
            now = sb_contact_get_info(p.contact);
            CHECK(memcmp(&before, &after, sizeof before) == 0);
            CHECK(told.touching == now.touching && told.retries == now.retries);
            CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
            CHECK_OK(sb_body_step(other.body, REAL(0.01), NULL));
            CHECK(same_places(&p, &other));
        } else {
            break;
        }
    }
    press_free(&p);
    press_free(&other);
}

/* Ends that are mended into what the material does not admit, and not at all as wholes. */
static int finds_apart(void *contact, const sb_vec3 *u)
{
    sbi_touch *touch = &((sb_contact *)contact)->touch;
    (void)own_accept(contact, u);
    touch->missed = 0;
    touch->apart = 1;
    return 0;
}

static int mends_badly(void *contact, sb_vec3 *u, int whole)
{
    (void)contact;
    asked += whole;
    if (!whole)
        u[0] = sb_v3(REAL(0.5), REAL(0.5), REAL(0.5)); /* of a cube of 2 cm */
    return !whole;
}

/* A shape that its material does not admit is no end of a step: the body can be stepped on from each. */
static void test_mended_badly(void)
{
    const sb_integrator integrators[] = {SB_EULER, SB_GENERALISED_ALPHA, SB_NEWMARK};
    for (int k = 0; k < 6; k++) {
        sb_body_def def = soft_def();
        sb_tool_def tool = press_sphere(0.006, 0.2, sb_v3(REAL(0.011), REAL(0.009), REAL(-0.03)));
        press p;
        def.integrator = integrators[k % 3];
        def.material = sb_material_neo_hookean(REAL(5e3), REAL(0.4), 1000);
        def.max_newton = k < 3 ? 1 : 6;
        p = press_make(scene_box(SB_TET4, 2, 2, 2, sb_v3(REAL(0.02), REAL(0.02), REAL(0.02)), 0.2), def,
                       sb_default_contact_def());
        CHECK_INT(press_add(&p, &tool), 0);
        own_accept = p.contact->touch.accept;
        p.contact->touch.accept = finds_apart;
        p.contact->touch.mend = mends_badly;
        asked = 0;
        for (int i = 0; i < 3; i++) {
            sb_energy energy;
            CHECK_OK(sb_body_step(p.body, REAL(1e-3), NULL));
            CHECK_OK(sb_body_energy(p.body, &energy));
            CHECK_INT(sb_contact_get_info(p.contact).mended, 0);
        }
        CHECK(asked > 0);
        press_free(&p);
    }
}

/* Loads that came after the contact need more room: where there is no memory the step fails as a whole step does. */
static void test_no_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    sb_body_def def = soft_def();
    sb_tool_def tool = press_sphere(0.006, 0.2, sb_v3(REAL(0.011), REAL(0.009), REAL(-0.03)));
    sb_step_info info;
    uint64_t hash;
    press p;
    int load, nodes[3] = {0, 1, 2}, failed = 0;
    sb_real stiffness = 1;
    def.allocator = allocator;
    p = press_make(scene_box(SB_TET4, 3, 3, 3, sb_v3(REAL(0.02), REAL(0.02), REAL(0.02)), 0.2), def,
                   sb_default_contact_def());
    CHECK_INT(press_add(&p, &tool), 0);
    throw_body(&p);
    CHECK_OK(sb_body_add_springs(p.body, nodes, 3, &stiffness, 1, p.mesh.nodes, &load, NULL));
    for (int i = 0; i < 8; i++) {
        hash = sb_body_state_hash(p.body);
        memory.fail_from = memory.calls + 1;
        if (sb_body_step(p.body, REAL(1.0 / 60), &info) != SB_OK) {
            failed++;
            CHECK_INT(info.error.result, SB_ERROR_DIVERGED);
            CHECK(sb_body_state_hash(p.body) == hash);
            memory.fail_from = 0;
            CHECK_OK(sb_body_step(p.body, REAL(1.0 / 60), &info));
        }
        memory.fail_from = 0;
    }
    CHECK_INT(failed, 1);
    press_free(&p);
    CHECK_INT(memory.live, 0);
}

static void test_recorded(void)
{
    press p = flying(SB_EULER), other = flying(SB_EULER);
    sb_recording *recording = NULL;
    sb_recording_report report;
    int divided = 0;
    CHECK_OK(sb_recording_start(p.body, 1, NULL, &recording, NULL));
    for (int i = 0; i < 10; i++) {
        sb_step_info info;
        CHECK_OK(sb_body_step(p.body, REAL(1.0 / 60), &info));
        divided += info.substeps > 0;
    }
    sb_recording_stop(recording);
    CHECK_OK(sb_recording_replay(recording, other.body, &report));
    CHECK_INT(report.steps, 10);
    CHECK(divided > 0);
    CHECK(same_places(&p, &other));
    sb_recording_destroy(recording);
    press_free(&p);
    press_free(&other);
}

/* Two jaws are sent to where they leave no room for what is between them. */
static void test_squeezed_to_nothing(void)
{
    for (int free_body = 0; free_body < 2; free_body++) {
        press p = press_make(scene_box(SB_TET4, 3, 3, 3, sb_v3(REAL(0.02), REAL(0.02), REAL(0.02)), 0.2), soft_def(),
                             sb_default_contact_def());
        sb_vec3 half = sb_v3(REAL(0.015), REAL(0.015), REAL(0.005));
        sb_tool_def jaw = press_box(half, 0.002, 0.5, sb_v3(REAL(0.01), REAL(0.01), REAL(-0.008)));
        double most = 0;
        if (!free_body)
            scene_fix_plane(p.body, &p.mesh, 0, 0, SB_XYZ);
        CHECK_INT(press_add(&p, &jaw), 0);
        jaw.pose.position.z = REAL(0.028);
        CHECK_INT(press_add(&p, &jaw), 1);
        for (int i = 0; i < 200; i++) {
            double close = i < 60 ? i * 0.0003 : i < 140 ? 0.018 : 0.018 - (i - 140) * 0.0006;
            press_move(&p, 0, sb_v3(REAL(0.01), REAL(0.01), REAL(-0.008 + close)), sb_quat_identity());
            press_move(&p, 1, sb_v3(REAL(0.01), REAL(0.01), REAL(0.028 - close)), sb_quat_identity());
            CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
            most = fmax(most, (double)sb_v3_norm(press_wrench(&p, 0).force));
        }
        CHECK(scene_all_finite(sb_body_positions(p.body), p.mesh.node_count));
        if (!CHECK(most > 0.1 && most < 400))
            printf("  squeezed by %g N\n", most);
        for (int i = 0; i < 200; i++)
            CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
        for (int n = 0; n < p.mesh.node_count && !free_body; n++)
            CHECK(sb_v3_norm(sb_v3_sub(sb_body_positions(p.body)[n], p.mesh.nodes[n])) < REAL(1e-4));
        press_free(&p);
    }
}

CHECK_SUITE(contact_substeps, {"flying", test_flying}, {"supports", test_supports},
            {"random flights", test_random_flights}, {"far too fast", test_far_too_fast},
            {"taken back", test_taken_back}, {"mended badly", test_mended_badly}, {"no memory", test_no_memory},
            {"recorded", test_recorded}, {"squeezed to nothing", test_squeezed_to_nothing});
