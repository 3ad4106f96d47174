/* test_contact_explicit: tools on bodies that step by central differences. */
#define SB_SPLIT_BUILD
#include "../src/softbody/body/body_private.h"
#include "../src/softbody/contact/contact_private.h"

#include <math.h>

#include "contact_scene.h"
#include "skeleton.h"

static const double side = 0.04;

typedef struct explicit_case {
    sb_element_type type;
    double young, damping; /* Pa, 1/s */
    int held;              /* 1: its lowest nodes are supported */
    double scale;          /* of all lengths */
    int *workers;          /* NULL: one */
} explicit_case;

static explicit_case usual(int held)
{
    explicit_case c = {SB_TET4, 5e3, 0, 0, 1, NULL};
    c.held = held;
    return c;
}

static press block_make(const explicit_case *c, sb_contact_def contact)
{
    sb_real length = REAL(side * c->scale);
    sb_body_def def = sb_default_body_def();
    press p;
    def.material = sb_material_corotated(REAL(c->young), REAL(0.4), 1000);
    def.integrator = SB_CENTRAL_DIFFERENCE;
    def.mass = SB_MASS_LUMPED;
    def.damping_mass = REAL(c->damping);
    def.max_substeps = 3000;
    if (c->workers)
        def.jobs = scene_jobs(c->workers);
    p = press_make(scene_box(c->type, 4, 4, 4, sb_v3(length, length, length), 0.15), def, contact);
    if (c->held)
        scene_fix_plane(p.body, &p.mesh, 2, 0, SB_XYZ);
    return p;
}

static sb_vec3 momentum(const press *p)
{
    sb_vec3 sum = {0, 0, 0};
    for (int i = 0; i < p->mesh.node_count; i++)
        sum = sb_v3_madd(sum, p->body->lumped_mass[i], sb_body_velocities(p->body)[i]);
    return sum;
}

static double energy(const press *p)
{
    sb_energy e;
    CHECK_OK(sb_body_energy(p->body, &e));
    return (double)e.kinetic + (double)e.elastic;
}

/* ---- forces ---- */

/* A free block is pushed: in calls of one substep its momentum changes by the mean of the forces at their ends. */
static void test_momentum(void)
{
    const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8};
    for (int t = 0; t < 3; t++) {
        explicit_case c = usual(0);
        press p;
        sb_tool_def def = press_sphere(0.01, 0.4, sb_v3(REAL(0.021), REAL(0.018), REAL(side + 0.0101)));
        sb_vec3 at = def.pose.position, before, force = {0, 0, 0};
        sb_real dt;
        double worst = 0, largest = 0, given = 0;
        int tool;
        c.type = types[t];
        p = block_make(&c, sb_default_contact_def());
        tool = press_add(&p, &def);
        CHECK_OK(sb_body_stable_step(p.body, &dt, NULL));
        dt *= REAL(0.2);
        before = momentum(&p);
        for (int i = 0; i < 400; i++) {
            sb_step_info info;
            sb_wrench wrench;
            sb_vec3 now, impulse;
            at = sb_v3_madd(at, dt, sb_v3(REAL(0.2), 0, REAL(-0.5)));
            press_move(&p, tool, at, sb_quat_identity());
            CHECK_OK(sb_body_step(p.body, dt, &info));
            CHECK_INT(info.substeps, 1);
            wrench = press_wrench(&p, tool);
            now = momentum(&p);
            impulse = sb_v3_scale(-dt / 2, sb_v3_add(force, wrench.force));
            worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(sb_v3_sub(now, before), impulse)));
            given += (double)sb_v3_norm(impulse);
            largest = fmax(largest, (double)sb_v3_norm(wrench.force));
            before = now;
            force = wrench.force;
        }
        CHECK(largest > 0.05);
        CHECK_NEAR(worst / given, 0, scene_tolerance(1e-12, 1e5));
        press_free(&p);
    }
}

/* Pressed slowly, it gives the force of an implicit step at rest; wrench and supports balance. */
static void test_press(void)
{
    explicit_case c = usual(1);
    double force[2] = {0, 0}, held = 0;
    for (int k = 0; k < 2; k++) {
        press p;
        sb_tool_def def = press_sphere(0.01, 0.3, sb_v3(REAL(0.02), REAL(0.02), REAL(side + 0.0101)));
        sb_vec3 at = def.pose.position;
        int tool;
        c.damping = 40;
        p = block_make(&c, sb_default_contact_def());
        tool = press_add(&p, &def);
        for (int i = 0; i < 80; i++) {
            at.z = REAL(side + 0.01 - 0.004 * (i < 40 ? i / 40.0 : 1));
            press_move(&p, tool, at, sb_quat_identity());
            if (k == 0)
                CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
        }
        if (k == 1)
            CHECK_OK(sb_body_solve_static(p.body, NULL, NULL));
        force[k] = (double)press_wrench(&p, tool).force.z;
        for (int i = 0; k == 0 && i < p.mesh.node_count; i++)
            held += (double)sb_body_reactions(p.body)[i].z;
        press_free(&p);
    }
    printf("    %.4f N, at rest %.4f N, held by %.6f N\n", force[0], force[1], held);
    CHECK_NEAR(force[0] / force[1], 0.92, 0.03); /* pressures are not remembered: overlap takes some of the way */
    CHECK_NEAR(held / force[0], 1, 1e-3);
}

/* ---- rest ---- */

/* A block falls on a floor and comes to rest: the floor bears its weight, and nothing chatters; the same at all scales.
 */
static void test_rest(void)
{
    for (int s = -1; s <= 1; s++) {
        explicit_case c = usual(0);
        press p;
        sb_tool_def floor = press_plane(0.5, sb_v3(0, 0, 0), 0);
        sb_wrench wrench;
        double weight = 0, length, time;
        int tool;
        c.scale = pow(10, s);
        c.damping = 30 / sqrt(c.scale);
        c.young = 5e3 * c.scale; /* sags by the same share */
        floor.pose.position.z = REAL(-1e-3 * c.scale);
        p = block_make(&c, sb_default_contact_def());
        tool = press_add(&p, &floor);
        length = side * c.scale;
        time = sqrt(c.scale);
        CHECK_OK(sb_body_set_gravity(p.body, sb_v3(0, 0, REAL(-9.81))));
        for (int i = 0; i < p.mesh.node_count; i++)
            weight += 9.81 * (double)p.body->lumped_mass[i];
        for (int i = 0; i < 150; i++)
            CHECK_OK(sb_body_step(p.body, REAL(0.01 * time), NULL));
        wrench = press_wrench(&p, tool);
        CHECK_NEAR(-(double)wrench.force.z / weight, 1, 1e-4);
        CHECK_NEAR((double)wrench.force.x / weight, 0, 1e-4);
        CHECK((double)sb_contact_get_info(p.contact).deepest < 2e-2 * length);
        CHECK(sb_contact_get_info(p.contact).sticking == sb_contact_get_info(p.contact).touching);
        for (int i = 0; i < p.mesh.node_count; i++)
            CHECK((double)sb_v3_norm(sb_body_velocities(p.body)[i]) < 1e-4 * length / time);
        press_free(&p);
    }
}

/* Thrown at a floor without damping it bounces, and has no more energy than before. */
static void test_energy(void)
{
    for (int k = 0; k < 4; k++) {
        const double speed = 0.1 * pow(30, k / 3.0);
        explicit_case c = usual(0);
        press p = block_make(&c, sb_default_contact_def());
        sb_tool_def floor = press_plane(0, sb_v3(0, 0, REAL(-1e-3)), 0);
        sb_vec3 *v = (sb_vec3 *)malloc((size_t)p.mesh.node_count * sizeof *v);
        double start, most = 0, up;
        press_add(&p, &floor);
        for (int i = 0; i < p.mesh.node_count; i++)
            v[i] = sb_v3(0, 0, REAL(-speed));
        CHECK_OK(sb_body_set_velocities(p.body, v));
        start = energy(&p);
        for (int i = 0; i < 60; i++) {
            CHECK_OK(sb_body_step(p.body, REAL(0.05 * side / speed), NULL));
            most = fmax(most, energy(&p));
        }
        up = (double)momentum(&p).z / (1000 * side * side * side) / speed;
        printf("    %.1f m/s: comes back with %.3f of it, energy at most %.5f, at the end %.5f\n", speed, up,
               most / start, energy(&p) / start);
        CHECK(most < 1.04 * start);
        CHECK(energy(&p) < 1.03 * start && up > 0.3); /* what first touches within a substep does so at its end */
        free(v);
        press_free(&p);
    }
}

/* ---- several tools ---- */

/* Tools that press on the same faces share what stiffness the nodes' masses admit. */
static void test_crowd(void)
{
    explicit_case c = usual(1);
    press p;
    int tools[6];
    c.damping = 20;
    p = block_make(&c, sb_default_contact_def());
    for (int t = 0; t < 6; t++) {
        sb_tool_def def = press_sphere(0.012, 0.5, sb_v3(REAL(0.018 + 0.001 * t), REAL(0.02), REAL(side + 0.0121)));
        tools[t] = press_add(&p, &def);
    }
    for (int i = 0; i < 60; i++) {
        for (int t = 0; t < 6; t++)
            press_move(&p, tools[t],
                       sb_v3(REAL(0.018 + 0.001 * t), REAL(0.02), REAL(side + 0.012 - fmin(1e-4 * i, 0.003))),
                       sb_quat_identity());
        CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
    }
    CHECK(sb_contact_get_info(p.contact).touching > 12);
    for (int i = 0; i < p.mesh.node_count; i++)
        CHECK(sb_v3_norm(sb_body_velocities(p.body)[i]) < REAL(1e-3));
    press_free(&p);
}

/* One on a spring is where spring and surface balance. */
static void test_hung(void)
{
    explicit_case c = usual(1);
    press p;
    sb_tool_def def = press_sphere(0.01, 0.3, sb_v3(REAL(0.02), REAL(0.02), REAL(side + 0.0101)));
    sb_wrench spring, wrench;
    sb_pose reached;
    int tool;
    c.damping = 40;
    def.coupling_stiffness = 100;
    p = block_make(&c, sb_default_contact_def());
    tool = press_add(&p, &def);
    for (int i = 0; i < 80; i++) {
        press_move(&p, tool, sb_v3(REAL(0.02), REAL(0.02), REAL(side + 0.01 - fmin(1e-4 * i, 0.004))),
                   sb_quat_identity());
        CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
    }
    wrench = press_wrench(&p, tool);
    CHECK_OK(sb_contact_coupling(p.contact, tool, &spring));
    CHECK_OK(sb_contact_reached(p.contact, tool, &reached, NULL));
    CHECK(wrench.force.z > REAL(0.1));
    CHECK_NEAR(sb_v3_norm(sb_v3_add(wrench.force, spring.force)) / wrench.force.z, 0, scene_tolerance(1e-8, 1e4));
    CHECK_NEAR(100 * ((double)reached.position.z - (side + 0.006)) / (double)wrench.force.z, 1,
               scene_tolerance(1e-6, 1e3));
    press_free(&p);
}

/* ---- nothing passes through ---- */

static void test_sweeps(void)
{
    unsigned long long seed = 77;
    int rounds = getenv("CHECK_SLOW") ? atoi(getenv("CHECK_SLOW")) : check_rounds(10), crossings = 0, touched = 0;
    for (int round = 0; round < rounds; round++) {
        explicit_case c = usual(check_random(&seed) < 0.5);
        press p;
        sb_boundary boundary;
        sb_tool_def def = press_sphere(check_random_in(&seed, 0.003, 0.006), 0.3, sb_v3(0, 0, 0));
        const sb_vec3 chain[2] = {{REAL(-0.03), 0, 0}, {REAL(0.03), 0, 0}};
        double speed = 0.1 * pow(100, check_random(&seed));
        sb_vec3 middle = sb_v3(REAL(side / 2), REAL(side / 2), REAL(side / 2)), way, *before;
        sb_pose from;
        int tool;
        c.young = pow(10, check_random_in(&seed, 3, 5));
        if (round % 2)
            def.shape = SB_TOOL_CAPSULES, def.points = chain, def.point_count = 2;
        p = block_make(&c, sb_default_contact_def());
        before = (sb_vec3 *)malloc((size_t)p.mesh.node_count * sizeof *before);
        CHECK_OK(sb_mesh_boundary(&p.mesh, 0, NULL, &boundary, NULL));
        way = sb_v3(REAL(check_random_in(&seed, -1, 1)), REAL(check_random_in(&seed, -1, 1)),
                    REAL(check_random_in(&seed, 0.2, 1)));
        way = sb_v3_scale(1 / sb_v3_norm(way), way);
        def.pose.position = sb_v3_madd(middle, REAL(0.06), way);
        def.pose.rotation = sb_quat_from_rotation_vector(
            sb_v3(REAL(check_random_in(&seed, -1, 1)), REAL(check_random_in(&seed, -1, 1)), 0));
        tool = press_add(&p, &def);
        from = def.pose;
        for (int i = 0; i < 24; i++) {
            const sbi_contact_tool *t = p.contact->tools + tool;
            double done = 0.015 + speed * 0.002 * (i + 1);
            memcpy(before, sb_body_positions(p.body), (size_t)p.mesh.node_count * sizeof *before);
            press_move(&p, tool, sb_v3_madd(def.pose.position, REAL(-fmin(done, 0.12)), way), def.pose.rotation);
            CHECK_OK(sb_body_step(p.body, REAL(0.002), NULL));
            touched += sb_contact_get_info(p.contact).touching > 0;
            CHECK(scene_all_finite(sb_body_positions(p.body), p.mesh.node_count));
            for (int f = 0; f < boundary.surface.element_count; f++) {
                sb_vec3 start[3], end[3];
                for (int a = 0; a < 3; a++) {
                    start[a] = before[boundary.surface.elements[3 * f + a]];
                    end[a] = sb_body_positions(p.body)[boundary.surface.elements[3 * f + a]];
                }
                crossings +=
                    def.shape == SB_TOOL_CAPSULES && skeleton_meets(t->shape, t->chain_reached, &t->reached, end);
                crossings +=
                    skeleton_passes(t->shape, t->chain_reached, &from, start, t->chain_reached, &t->reached, end);
            }
            from = t->reached;
        }
        sb_boundary_free(&boundary);
        free(before);
        press_free(&p);
    }
    CHECK_INT(crossings, 0);
    CHECK(touched > 2 * rounds);
}

/* ---- states ---- */

static void slide(const press *p, int tool, int from, int to)
{
    for (int i = from; i < to; i++) {
        press_move(p, tool, sb_v3(REAL(0.015 + 0.0003 * i), REAL(0.02), REAL(side + 0.008)), sb_quat_identity());
        CHECK_OK(sb_body_step(p->body, REAL(0.004), NULL));
    }
}

/* Loaded it goes on with the same bits, on any number of threads; a call that fails leaves everything as it was. */
static void test_states(void)
{
    int workers = 1, tool;
    explicit_case c = usual(1);
    press p;
    sb_tool_def def = press_sphere(0.01, 0.3, sb_v3(REAL(0.015), REAL(0.02), REAL(side + 0.0101)));
    size_t size;
    void *state;
    uint64_t hash, undone;
    c.workers = &workers;
    p = block_make(&c, sb_default_contact_def());
    tool = press_add(&p, &def);
    slide(&p, tool, 0, 15);
    CHECK(sb_contact_get_info(p.contact).touching > 0);
    size = sb_body_state_size(p.body);
    state = malloc(size);
    CHECK_OK(sb_body_state_save(p.body, state, size));
    slide(&p, tool, 15, 25);
    hash = sb_body_state_hash(p.body);
    for (workers = 1; workers <= 3; workers += 2) {
        CHECK_OK(sb_body_state_load(p.body, state, size, NULL));
        slide(&p, tool, 15, 25);
        CHECK(sb_body_state_hash(p.body) == hash);
    }
    undone = sb_body_state_hash(p.body);
    CHECK(sb_body_step(p.body, 1e6, NULL) != SB_OK); /* more than max_substeps */
    CHECK(sb_body_state_hash(p.body) == undone);
    free(state);
    press_free(&p);
}

/* What needs a system says so; organs are left to implicit steps. */
static void test_refused(void)
{
    explicit_case c = usual(1);
    press p = block_make(&c, sb_default_contact_def());
    sb_contact_def def = sb_default_contact_def();
    sb_tool_def sphere = press_sphere(0.01, 0.3, sb_v3(REAL(0.02), REAL(0.02), REAL(side + 0.0101)));
    sb_haptic_def hand = sb_default_haptic_def();
    sb_contact *contact = NULL;
    sb_haptic *haptic = NULL;
    sb_real k[6][6];
    hand.contact = p.contact;
    hand.tool = press_add(&p, &sphere);
    hand.max_force = 5, hand.max_torque = 1, hand.max_stiffness = 1000, hand.max_damping = 3;
    CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
    CHECK_RESULT(sb_contact_stiffness(p.contact, hand.tool, k), SB_ERROR_STATE);
    CHECK_RESULT(sb_haptic_create(&hand, &haptic, NULL), SB_ERROR_UNSUPPORTED);
    sb_contact_destroy(p.contact);
    def.body = p.body;
    def.pairs = SB_CONTACT_SELF;
    p.contact = NULL;
    CHECK_RESULT(sb_contact_create(&def, &contact, NULL), SB_ERROR_UNSUPPORTED);
    press_free(&p);
}

CHECK_SUITE(contact_explicit, {"momentum", test_momentum}, {"press", test_press}, {"rest", test_rest},
            {"energy", test_energy}, {"crowd", test_crowd}, {"hung", test_hung}, {"sweeps", test_sweeps},
            {"states", test_states}, {"refused", test_refused});
