/* Tests of the call at 1 kHz: planes, coupling, blending, limits and the bank, by themselves and in a simulated hand.
 * They are internal as long as no contact makes frames. */
#define SB_SPLIT_BUILD
#include "../src/softbody/contact/haptic_servo.h"

#include "check.h"
#include "dense_double.h"
#include "haptic_hand.h"

/* ---- helpers ---- */

typedef unsigned long long seed_t;

static sbi_d3 random_d3(seed_t *seed, double size)
{
    double x = check_random_in(seed, -size, size), y = check_random_in(seed, -size, size);
    return sbi_d(x, y, check_random_in(seed, -size, size));
}

/* Before its first frame. */
static sbi_haptic_model no_model(void)
{
    sbi_haptic_model model;
    memset(&model, 0, sizeof model);
    return model;
}

static sbi_d3 random_unit(seed_t *seed)
{
    sbi_d3 v = random_d3(seed, 1);
    while (!(sbi_d_norm(v) > 0.1))
        v = random_d3(seed, 1);
    return sbi_d_scale(1 / sbi_d_norm(v), v);
}

static sbi_d_pose random_pose(seed_t *seed, double size, double turn)
{
    sbi_turn none = {1, 0, 0, 0};
    sbi_d3 v = random_d3(seed, turn);
    sbi_d_pose pose;
    pose.position = random_d3(seed, size);
    pose.rotation = sbi_turn_unit(sbi_turn_make(1, v.x, v.y, v.z), none);
    return pose;
}

/* Planes in contact with forces of about a newton. mu large: all stick. */
static sbi_haptic_frame random_frame(seed_t *seed, int count, double mu)
{
    sbi_haptic_frame frame;
    memset(&frame, 0, sizeof frame);
    frame.pose = random_pose(seed, 0.1, 1);
    frame.count = count;
    for (int c = 0; c < count; c++) {
        sbi_haptic_cluster *k = frame.clusters + c;
        k->point = random_d3(seed, 0.02);
        k->normal = random_unit(seed);
        k->push = check_random_in(seed, 0.5, 2);
        k->friction = mu;
        k->stiffness = check_random_in(seed, 50, 3000);
        k->tangential = check_random_in(seed, 0.3, 1) * k->stiffness;
        k->traction = sbi_d_across(random_d3(seed, 0.5 * fmin(mu, 1) * k->push), k->normal);
        k->torque = random_d3(seed, 1e-3);
    }
    return frame;
}

static sb_haptic_def device(double force, double stiffness, double damping)
{
    sb_haptic_def def = sb_default_haptic_def();
    def.max_force = force;
    def.max_stiffness = stiffness;
    def.max_damping = damping;
    return def;
}

static sb_haptic_def random_device(seed_t *seed, double most_force, double damping)
{
    double force = check_random_in(seed, 3, most_force);
    return device(force, check_random_in(seed, 500, 5000), damping);
}

static sb_tool_state state_at(double x, double y, double z, double time)
{
    sb_tool_state state;
    memset(&state, 0, sizeof state);
    state.position[0] = x, state.position[1] = y, state.position[2] = z;
    state.rotation[0] = state.rotation[4] = state.rotation[8] = 1;
    state.time = time;
    return state;
}

/* A plane z = 0 that the tool's origin touches with `push` at height z. */
static sbi_haptic_frame plane_frame(double z, double push, double stiffness)
{
    sbi_haptic_frame frame;
    memset(&frame, 0, sizeof frame);
    frame.pose.position = sbi_d(0, 0, z);
    frame.pose.rotation.w = 1;
    frame.count = 1;
    frame.clusters[0].normal = sbi_d(0, 0, 1);
    frame.clusters[0].push = push;
    frame.clusters[0].stiffness = stiffness;
    return frame;
}

static double wrench_error(sbi_d_wrench a, sbi_d_wrench b)
{
    return fmax(sbi_d_norm(sbi_d_sub(a.force, b.force)) / (sbi_d_norm(b.force) + 1e-300),
                sbi_d_norm(sbi_d_sub(a.torque, b.torque)) / (sbi_d_norm(b.torque) + 1e-300));
}

/* ---- rotations ---- */

static void test_turns(void)
{
    seed_t seed = 3;
    double m[9], worst = 0, between = 0, further = 0;
    const double zeros[9] = {0};
    for (int i = 0; i < 10000; i++) {
        sbi_d_pose pose = random_pose(&seed, 1, i % 2 ? 10 : 1);
        sbi_d3 by = random_d3(&seed, i % 3 ? 1.7 : 1e-7), back;
        sbi_turn q, other = pose.rotation;
        sbi_turn_to_matrix(pose.rotation, m);
        q = sbi_turn_from_matrix(m, sbi_turn_make(1, 0, 0, 0));
        worst = fmax(worst, sbi_d_norm(sbi_turn_between(q, pose.rotation)));
        for (int k = 0; k < 1000; k++)
            other = i < 20 ? sbi_turn_further(other, sbi_d_scale(1e-3, by)) : other;
        back = sbi_turn_between(pose.rotation, other);
        if (i < 20)
            further = fmax(further, sbi_d_norm(sbi_d_sub(back, by)));
        between = fmax(between, sbi_d_norm(sbi_d_add(back, sbi_turn_between(other, pose.rotation))));
    }
    CHECK_NEAR(worst, 0, 1e-15 * 20);
    CHECK_NEAR(between, 0, 1e-14);
    CHECK_NEAR(further, 0, 3e-6); /* 1,000 third powers of 3e-3, over 12 */
    CHECK(sbi_turn_from_matrix(zeros, sbi_turn_make(0, 1, 0, 0)).x == 1);
    memset(m, 0, sizeof m);
    m[0] = m[4] = m[8] = -1; /* a mirror: whatever comes out is a rotation */
    CHECK(sbi_d_within(sbi_turn_from_matrix(m, sbi_turn_make(1, 0, 0, 0)).w, 1));
}

static void test_from_openhaptics(void)
{
    /* column-major, mm: x' = y, y' = -x, z' = z */
    const double transform[16] = {0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 100, -20, 3, 1}, velocity[3] = {1000, 0, -2};
    sb_tool_state state = sb_haptic_from_hd(transform, velocity);
    CHECK_NEAR(state.position[0], 0.1, 1e-16);
    CHECK_NEAR(state.position[1], -0.02, 1e-16);
    CHECK_NEAR(state.position[2], 0.003, 1e-16);
    CHECK_NEAR(state.rotation[1], 1, 0); /* row 0, column 1 */
    CHECK_NEAR(state.rotation[3], -1, 0);
    CHECK_NEAR(state.rotation[8], 1, 0);
    CHECK_NEAR(state.velocity[0], 1, 1e-15);
    CHECK_NEAR(state.velocity[2], -0.002, 1e-18);
    state = sb_haptic_from_hd(NULL, NULL);
    CHECK(state.position[0] == 0 && state.rotation[0] == 0 && state.velocity[2] == 0);
}

/* ---- planes ---- */

/* At its own pose a frame gives back the step's wrench, whatever has happened in between. */
static void test_frame_at_its_pose(void)
{
    seed_t seed = 5;
    for (int i = 0; i < 200; i++) {
        sbi_haptic_frame frame = random_frame(&seed, 1 + i % SBI_HAPTIC_CLUSTERS, 100);
        sbi_haptic_coupling rigid = {0, 0, 0};
        sbi_haptic_model model = no_model();
        sbi_d_wrench sum, felt;
        sbi_d_pose tool;
        double stored, expected = 0;
        memset(&sum, 0, sizeof sum);
        for (int c = 0; c < frame.count; c++) {
            const sbi_haptic_cluster *k = frame.clusters + c;
            sbi_d3 force = sbi_d_madd(k->traction, k->push, k->normal);
            sum.force = sbi_d_add(sum.force, force);
            sum.torque = sbi_d_add(sum.torque, sbi_d_cross(sbi_turn_apply(frame.pose.rotation, k->point), force));
            sum.torque = sbi_d_add(sum.torque, k->torque);
            expected +=
                k->push * k->push / (2 * k->stiffness) + sbi_d_dot(k->traction, k->traction) / (2 * k->tangential);
        }
        CHECK(sbi_haptic_frame_is_sound(&frame));
        sbi_haptic_model_set(&model, &frame);
        felt = sbi_haptic_model_feel(&model, &rigid, &frame.pose, &tool, &stored);
        CHECK_NEAR(wrench_error(felt, sum), 0, 1e-12);
        CHECK_NEAR(stored / expected, 1, 1e-11);
    }
}

/* One plane: a spring that does not pull, and friction whose anchor follows. */
static void test_plane(void)
{
    sbi_haptic_frame frame = plane_frame(-0.001, 1, 1000);
    sbi_haptic_coupling rigid = {0, 0, 0};
    sbi_haptic_model model = no_model();
    sbi_d_pose pose = frame.pose, tool;
    sbi_d_wrench felt;
    double stored;
    frame.clusters[0].friction = 0.5;
    frame.clusters[0].tangential = 200;
    sbi_haptic_model_set(&model, &frame);
    pose.position = sbi_d(0.001, 0, -0.002);
    felt = sbi_haptic_model_feel(&model, &rigid, &pose, &tool, &stored);
    CHECK_NEAR(felt.force.z, 2, 1e-12);
    CHECK_NEAR(felt.force.x, -0.2, 1e-12); /* sticks: 200 N/m */
    CHECK_NEAR(stored, 4.0 / 2000 + 0.04 / 400, 1e-14);
    pose.position.x = 0.02; /* slides: 0.5 of 2 N */
    felt = sbi_haptic_model_feel(&model, &rigid, &pose, &tool, &stored);
    CHECK_NEAR(felt.force.x, -1, 1e-12);
    CHECK_NEAR(model.anchors[0].x, 0.02 - 1.0 / 200, 1e-12);
    pose.position.x = 0.018; /* and back: sticks to where it slid */
    felt = sbi_haptic_model_feel(&model, &rigid, &pose, &tool, &stored);
    CHECK_NEAR(felt.force.x, -0.6, 1e-12);
    pose.position.z = 0.001; /* lifts off: nothing pulls, nothing is remembered */
    felt = sbi_haptic_model_feel(&model, &rigid, &pose, &tool, &stored);
    CHECK(sbi_d_norm(felt.force) == 0 && stored == 0);
    CHECK_NEAR(model.anchors[0].x, 0.018, 1e-12);
    frame.clusters[0].push = -0.5; /* 0.5 mm off */
    sbi_haptic_model_set(&model, &frame);
    pose.position = sbi_d(0, 0, -0.0014);
    CHECK(sbi_d_norm(sbi_haptic_model_feel(&model, &rigid, &pose, &tool, &stored).force) == 0);
    pose.position.z = -0.0017; /* 0.2 mm in */
    CHECK_NEAR(sbi_haptic_model_feel(&model, &rigid, &pose, &tool, &stored).force.z, 0.2, 1e-12);
}

static void test_unsound_frames(void)
{
    const double bad[] = {(double)NAN, (double)INFINITY, -(double)INFINITY, 1e300};
    sbi_haptic_frame frame = plane_frame(0, 1, 100), forged;
    CHECK(sbi_haptic_frame_is_sound(&frame));
    check_bad_numbers();
    for (size_t at = 0; at + sizeof(double) <= sizeof(sbi_haptic_cluster); at += sizeof(double))
        for (int i = 0; i < 4; i++) {
            forged = frame;
            memcpy((char *)forged.clusters + at, bad + i, sizeof(double));
            CHECK(!sbi_haptic_frame_is_sound(&forged));
        }
    for (int i = 0; i < 4; i++) {
        forged = frame;
        forged.pose.position.y = bad[i];
        CHECK(!sbi_haptic_frame_is_sound(&forged));
        forged = frame;
        forged.pose.rotation.z = bad[i];
        CHECK(!sbi_haptic_frame_is_sound(&forged));
    }
    forged = frame;
    forged.clusters[0].stiffness = -1;
    CHECK(!sbi_haptic_frame_is_sound(&forged));
    forged = frame;
    forged.count = SBI_HAPTIC_CLUSTERS + 1;
    CHECK(!sbi_haptic_frame_is_sound(&forged));
    forged.count = -1;
    CHECK(!sbi_haptic_frame_is_sound(&forged));
}

/* Kelvin-Voigt tissue with random elastic and relaxing shares, in implicit Euler steps: once a model has seen some of
 * its frames it says the push of a step that begins where the tool is, for any way; not so without what relaxes. */
static void test_relaxing(void)
{
    seed_t seed = 13;
    double worst = 0, without = 0;
    for (int i = 0; i < 100; i++) {
        double unit = exp(check_random_in(&seed, -7, 7)), elastic = check_random_in(&seed, 100, 2000);
        double viscous = elastic * check_random_in(&seed, 0.1, 3), z[3] = {0, 0, 0}, push, stored, share = 0;
        sbi_haptic_coupling rigid = {0, 0, 0};
        sbi_haptic_model model = no_model();
        sbi_d_pose pose, tool;
        for (int step = 0; step < 14; step++) {
            sbi_haptic_frame frame;
            z[2] = z[1], z[1] = z[0], z[0] = -unit * (0.05 + 0.01 * step + check_random_in(&seed, 0, 0.01));
            push = -elastic * z[0] - viscous * (z[0] - z[1]);
            frame = plane_frame(z[0], push, elastic + viscous);
            if (step > 6) { /* where the step before ended, the tool of a step ago was where that one began */
                sbi_d_wrench felt;
                pose = frame.pose;
                sbi_haptic_model_relax(&model, sbi_d(0, 0, z[1] - model.frame.pose.position.z));
                felt = sbi_haptic_model_feel(&model, &rigid, &pose, &tool, &stored);
                worst = fmax(worst, fabs(felt.force.z - push) / push);
                share = fabs(push - model.frame.clusters[0].push + (elastic + viscous) * (z[0] - z[1])) / push;
                without = fmax(without, share);
            }
            sbi_haptic_model_set(&model, &frame);
        }
    }
    printf("    push of the next step off by %.1e, without relaxing by %.2f\n", worst, without);
    CHECK(worst < 1e-3 && without > 0.1);
}

/* ---- the coupling ---- */

/* q = (K_vc I - K)^-1 (K_vc x + F - K q0) and the hand's K_vc (q - x), with planes that all stick: exact for a rigid
 * rotation. */
static void test_coupling_formula(void)
{
    seed_t seed = 7;
    double worst = 0, worst_force = 0;
    for (int i = 0; i < 500; i++) {
        sbi_haptic_frame frame = random_frame(&seed, 1 + i % SBI_HAPTIC_CLUSTERS, 1e6);
        sbi_haptic_coupling coupling = {check_random_in(&seed, 50, 5000), 0, 0};
        sbi_haptic_model model = no_model();
        sbi_d_pose hand = frame.pose, tool = frame.pose;
        sbi_d_wrench felt;
        double k[9] = {0}, f[3] = {0}, b[3], q[3], x[3], q0[3], stored;
        for (int c = 0; c < frame.count; c++)
            frame.clusters[c].push += 5; /* stays in contact */
        sbi_haptic_model_set(&model, &frame);
        sbi_d_put(q0, frame.pose.position);
        for (int c = 0; c < frame.count; c++) { /* minus K of the tissue, and F */
            const sbi_haptic_cluster *p = frame.clusters + c;
            double n[3], force[3];
            sbi_d_put(n, p->normal);
            sbi_d_put(force, sbi_d_madd(p->traction, p->push, p->normal));
            for (int r = 0; r < 3; r++) {
                f[r] += force[r];
                for (int s = 0; s < 3; s++)
                    k[3 * r + s] += (p->stiffness - p->tangential) * n[r] * n[s] + (r == s ? p->tangential : 0);
            }
        }
        hand.position =
            sbi_d_madd(hand.position, -1 / coupling.translation, sbi_d_from(f)); /* holds against the planes */
        hand.position = sbi_d_add(hand.position, random_d3(&seed, 3e-4));
        sbi_d_put(x, hand.position);
        for (int r = 0; r < 3; r++) {
            b[r] = coupling.translation * x[r] + f[r];
            for (int s = 0; s < 3; s++)
                b[r] += k[3 * r + s] * q0[s];
        }
        for (int r = 0; r < 3; r++)
            k[4 * r] += coupling.translation;
        CHECK(dense_factor(k, 3));
        dense_solve(k, 3, b, q);
        felt = sbi_haptic_model_feel(&model, &coupling, &hand, &tool, &stored);
        for (int r = 0; r < 3; r++)
            b[r] = coupling.translation * (q[r] - x[r]);
        worst = fmax(worst, sbi_d_norm(sbi_d_sub(tool.position, sbi_d_from(q))));
        worst_force = fmax(worst_force, sbi_d_norm(sbi_d_sub(felt.force, sbi_d_from(b))) / sbi_d_norm(felt.force));
    }
    CHECK_NEAR(worst, 0, 1e-12);
    CHECK_NEAR(worst_force, 0, 5e-11);
}

/* The tool is pulled with all that the coupling may and the hand goes on in the same direction, however far: what is
 * felt stays, with the tool where the frame has it. Without a bound, planes that tilt turn it aside. */
static void test_bounded_pull(void)
{
    seed_t seed = 19;
    double worst = 0, aside = 0;
    for (int i = 0; i < 200; i++) {
        sbi_haptic_frame frame = random_frame(&seed, 1 + i % SBI_HAPTIC_CLUSTERS, 1e6);
        sbi_haptic_coupling coupling = {check_random_in(&seed, 50, 5000), 0, 0};
        sbi_d3 force = sbi_d(0, 0, 0);
        for (int c = 0; c < frame.count; c++) {
            const sbi_haptic_cluster *p = frame.clusters + c;
            frame.clusters[c].push += 5; /* stays in contact */
            force = sbi_d_add(force, sbi_d_madd(p->traction, p->push, p->normal));
        }
        for (int bounded = 0; bounded < 2; bounded++) {
            const double times = exp(check_random_in(&seed, 0, 5)), most = sbi_d_norm(force);
            sbi_haptic_model model = no_model();
            sbi_d_pose hand = frame.pose, tool = frame.pose;
            sbi_d_wrench felt;
            double stored, off;
            coupling.most = bounded ? most : 0;
            sbi_haptic_model_set(&model, &frame);
            hand.position = sbi_d_madd(hand.position, -times / coupling.translation, force);
            felt = sbi_haptic_model_feel(&model, &coupling, &hand, &tool, &stored);
            off = sbi_d_norm(sbi_d_sub(sbi_d_scale(most / sbi_d_norm(felt.force), felt.force), force)) / most;
            if (!bounded) {
                aside = fmax(aside, off);
                continue;
            }
            worst = fmax(worst, sbi_d_norm(sbi_d_sub(felt.force, force)) / most);
            CHECK_NEAR(sbi_d_norm(sbi_d_sub(tool.position, frame.pose.position)), 0, 1e-9);
        }
    }
    CHECK_NEAR(worst, 0, 1e-7);
    CHECK(aside > 0.1);
}

/* With turns, slip and planes that let go: tissue and coupling balance where the tool is said to be, from wherever the
 * search starts. */
static void test_coupling_balance(void)
{
    seed_t seed = 11;
    int unfound = 0, count = check_quick() ? 2000 : 20000;
    for (int i = 0; i < count; i++) {
        sbi_haptic_frame frame = random_frame(&seed, 1 + i % SBI_HAPTIC_CLUSTERS, i % 3 ? 0.3 : 0);
        sbi_haptic_coupling coupling, rigid = {0, 0, 0};
        sbi_haptic_model model = no_model(), copy;
        sbi_d_pose hand = frame.pose, tool = frame.pose, again;
        sbi_d_wrench felt, tissue;
        double stored, error;
        coupling.translation = check_random_in(&seed, 200, 3000);
        coupling.rotation = check_random_in(&seed, 0.2, 3);
        sbi_haptic_model_set(&model, &frame);
        hand.position = sbi_d_add(hand.position, random_d3(&seed, 1e-3));
        hand.rotation = sbi_turn_further(hand.rotation, random_d3(&seed, 0.05));
        copy = model;
        felt = sbi_haptic_model_feel(&model, &coupling, &hand, &tool, &stored);
        tissue = sbi_haptic_model_feel(&copy, &rigid, &tool, &again, &stored);
        error = sbi_d_norm(sbi_d_sub(felt.force, tissue.force)) / (sbi_d_norm(felt.force) + 0.01);
        error = fmax(error, sbi_d_norm(sbi_d_sub(felt.torque, tissue.torque)) / (sbi_d_norm(felt.torque) + 1e-4));
        unfound += !(error < 1e-3);
    }
    printf("    %d of %d balances not found to 1e-3\n", unfound, count);
    CHECK(unfound <= count / 100);
}

/* What the hand feels has two springs in series for its tangent, K_vc (K_vc I - K)^-1 K, also in turns. */
static void test_coupling_tangent(void)
{
    sbi_haptic_frame frame = plane_frame(0, 1, 600);
    sbi_haptic_coupling coupling = {900, 2, 0};
    double stored, way = 1e-5, turn = 1e-5, arm = 0.03, low, high;
    sbi_d_pose hand = frame.pose, tool = frame.pose;
    sbi_haptic_model model = no_model();
    sbi_haptic_model_set(&model, &frame);
    hand.position.z = -way;
    high = sbi_haptic_model_feel(&model, &coupling, &hand, &tool, &stored).force.z;
    hand.position.z = way;
    low = sbi_haptic_model_feel(&model, &coupling, &hand, &tool, &stored).force.z;
    CHECK_NEAR((high - low) / (2 * way), 900 * 600 / 1500.0, 1e-6);
    CHECK_NEAR(low, 900 * (tool.position.z - hand.position.z), 1e-12);
    frame.clusters[0].point = sbi_d(arm, 0, 0); /* turned about y it yields with 600 arm^2 */
    frame.clusters[0].push = 0.001;
    sbi_haptic_model_set(&model, &frame);
    coupling.translation = 1e9; /* that the tool does not give way */
    hand = frame.pose;
    hand.rotation = sbi_turn_further(frame.pose.rotation, sbi_d(0, turn, 0));
    high = sbi_haptic_model_feel(&model, &coupling, &hand, &tool, &stored).torque.y;
    hand.rotation = sbi_turn_further(frame.pose.rotation, sbi_d(0, -turn, 0));
    low = sbi_haptic_model_feel(&model, &coupling, &hand, &tool, &stored).torque.y;
    stored = 600 * arm * arm;
    CHECK_NEAR(high, -0.001 * arm * 2 / (2 + stored) - turn * 2 * stored / (2 + stored), 1e-8);
    CHECK_NEAR((high - low) / (2 * turn), -2 * stored / (2 + stored), 1e-3);
}

/* ---- definitions ---- */

static void test_definition(void)
{
    sb_haptic_def def = device(8, 2000, 5);
    sbi_servo servo, untouched;
    sb_error error;
    memset(&servo, 7, sizeof servo);
    untouched = servo;
    def.max_torque = 0.4;
    CHECK_OK(sbi_servo_begin(&servo, &def, &error));
    CHECK_NEAR(servo.def.coupling, 1000, 0);
    CHECK_NEAR(servo.def.coupling_turning, 1000 * 0.05 * 0.05, 1e-12);
    CHECK_NEAR(servo.def.max_slew, 4000, 1e-9);
    def.coupling = 0;
    CHECK_OK(sbi_servo_begin(&servo, &def, &error));
    CHECK_NEAR(servo.def.coupling_turning, 0, 0);
    check_bad_numbers();
    for (int field = 0; field < 5; field++)
        for (int k = 0; k < 4; k++) {
            const double bad[] = {0, -1, (double)NAN, (double)INFINITY};
            double *fields[5];
            sb_haptic_def wrong = device(8, 2000, 5);
            fields[0] = &wrong.max_force, fields[1] = &wrong.max_stiffness, fields[2] = &wrong.scale_motion;
            fields[3] = &wrong.scale_force, fields[4] = &wrong.timeout;
            *fields[field] = bad[k];
            servo = untouched;
            CHECK_RESULT(sbi_servo_begin(&servo, &wrong, &error), k < 2 ? SB_ERROR_ARGUMENT : SB_ERROR_NOT_FINITE);
            CHECK(memcmp(&servo, &untouched, sizeof servo) == 0);
            CHECK(strstr(error.message, "def.") != NULL);
        }
    def.cookie = 0;
    CHECK_RESULT(sbi_servo_begin(&servo, &def, &error), SB_ERROR_ARGUMENT);
}

/* ---- frames that come and stay away ---- */

/* A hand at rest: a frame with another force changes it by no more than the offset fades, towards the frame's. */
static void test_blending(void)
{
    sb_haptic_def def = device(20, 2000, 5);
    sbi_servo servo;
    sb_wrench_d out;
    sbi_haptic_frame frame = plane_frame(-0.002, 1, 500);
    double time = 0, before = 0, largest = 0;
    def.coupling = 0;
    CHECK_OK(sbi_servo_begin(&servo, &def, NULL));
    for (int i = 0; i < 400; i++) { /* frames each 10 ms, which agree */
        sb_tool_state at = state_at(0, 0, -0.002, time += 1e-3);
        sbi_servo_call(&servo, &at, i % 10 ? NULL : &frame, &out);
    }
    CHECK_NEAR(servo.info.period, 0.01, 1e-4);
    CHECK_NEAR(out.force[2], 1, 1e-12);
    frame.clusters[0].push = 3;
    for (int i = 0; i < 30; i++) {
        sb_tool_state at = state_at(0, 0, -0.002, time += 1e-3);
        before = out.force[2];
        CHECK_INT(sbi_servo_call(&servo, &at, i ? NULL : &frame, &out), 1);
        largest = fmax(largest, out.force[2] - before);
        CHECK_NEAR(3 - out.force[2], 2 * fmax(0, 1 - (i + 1) / 25.0), 0.03);
    }
    CHECK(largest < 2 / 25.0 * 1.02); /* of 25 ms: two and a half periods */
}

static void test_stale(void)
{
    sb_haptic_def def = device(20, 2000, 5);
    sbi_servo servo;
    sb_wrench_d out;
    sbi_haptic_frame frame = plane_frame(-0.002, 1, 500);
    sb_tool_state none = state_at(0, 0, -0.002, 0);
    double time = 0, before;
    def.coupling = 0;
    CHECK_OK(sbi_servo_begin(&servo, &def, NULL));
    CHECK_INT(sbi_servo_call(&servo, &none, NULL, &out), 0);
    CHECK(out.force[2] == 0);
    for (int i = 0; i < 500; i++) {
        sb_tool_state at = state_at(0, 0, -0.002, time += 1e-3);
        int follows;
        before = out.force[2];
        follows = sbi_servo_call(&servo, &at, i % 10 || i > 100 ? NULL : &frame, &out);
        if (i > 100 && i <= 200) /* the last came with 100 */
            CHECK_NEAR(out.force[2], 1, 1e-4);
        if (i > 201 && i < 300)
            CHECK_NEAR(out.force[2], 1 - 0.01 * (i - 200), 2e-3);
        if (i > 301)
            CHECK(out.force[2] == 0);
        if (i != 200) /* when it is as old as the timeout to rounding */
            CHECK_INT(follows, i < 200);
    }
    for (int i = 0; i < 40; i++) { /* and comes back within periods, without a jump */
        sb_tool_state at = state_at(0, 0, -0.002, time += 1e-3);
        before = out.force[2];
        sbi_servo_call(&servo, &at, i % 10 ? NULL : &frame, &out);
        CHECK(out.force[2] - before < 0.25);
    }
    CHECK_NEAR(out.force[2], 1, 0.01);
}

/* ---- limits and the bank ---- */

static void test_limits(void)
{
    sb_haptic_def def = device(3, 1e4, 0);
    sbi_servo servo;
    sb_wrench_d out;
    sbi_haptic_frame frame = plane_frame(0, 0, 1000);
    double before = 0, size;
    def.coupling = 0;
    def.max_slew = 500;
    frame.clusters[0].normal = sbi_d(0.6, 0, 0.8);
    CHECK_OK(sbi_servo_begin(&servo, &def, NULL));
    for (int i = 0; i < 300; i++) {
        double depth = i < 100 ? 1e-4 * i : 0.01;
        sb_tool_state at = state_at(-0.6 * depth, 0, -0.8 * depth, 1e-3 * i);
        sbi_servo_call(&servo, &at, i % 10 ? NULL : &frame, &out);
        size = sbi_d_norm(sbi_d_from(out.force));
        CHECK(size <= 3 * (1 + 1e-15) && fabs(size - before) <= 0.5 * (1 + 1e-12));
        before = size;
    }
    CHECK_NEAR(out.force[0], 1.8, 1e-9); /* the direction is kept */
    CHECK_NEAR(out.force[2], 2.4, 1e-9);
    CHECK(out.torque[0] == 0 && out.torque[1] == 0 && out.torque[2] == 0); /* the device gives none */
}

/* The bank is what the held force has done, exactly, wherever the hand goes and whatever turns. */
static void test_energy_is_exact(void)
{
    sb_haptic_def def = device(100, 1e-6, 0); /* a bank without a bound worth the name, next to no own damping */
    sbi_servo servo;
    sb_wrench_d out;
    sbi_haptic_frame frame = plane_frame(0, 2, 0);
    sbi_d_pose pose = {{0, 0, 0}, {1, 0, 0, 0}}, before = pose;
    seed_t seed = 9;
    double sum = 0;
    def.coupling = 0;
    def.max_torque = 5;
    frame.clusters[0].torque = sbi_d(0.01, -0.02, 0.1);
    CHECK_OK(sbi_servo_begin(&servo, &def, NULL));
    memset(&out, 0, sizeof out);
    for (int i = 0; i < 2000; i++) {
        sb_tool_state at;
        pose.position = sbi_d_add(pose.position, sbi_d_madd(random_d3(&seed, 1e-4), -1e-4, sbi_d(0, 0, i < 100)));
        pose.rotation =
            sbi_turn_further(pose.rotation, sbi_d_madd(random_d3(&seed, 1e-3), -1e-3, sbi_d(0, 0, i < 100)));
        at = state_at(pose.position.x, pose.position.y, pose.position.z, 1e-3 * i);
        sbi_turn_to_matrix(pose.rotation, at.rotation);
        if (i > 0)
            sum -= sbi_d_dot(sbi_d_from(out.force), sbi_d_sub(pose.position, before.position)) +
                   sbi_d_dot(sbi_d_from(out.torque), sbi_turn_between(before.rotation, pose.rotation));
        sbi_servo_call(&servo, &at, i % 10 ? NULL : &frame, &out);
        before = pose;
        CHECK_NEAR(servo.info.energy, sum, 1e-11);
    }
    CHECK(sum > 0.01);
}

/* With an empty bank nothing pushes along the motion, and a debt is damped: the force is against it. */
static void test_empty_bank(void)
{
    sb_haptic_def def = device(5, 500, 2);
    sbi_servo servo;
    sb_wrench_d out;
    sbi_haptic_frame frame = plane_frame(0, 1, 0);
    double given = 0, z = 0;
    def.coupling = 0;
    CHECK_OK(sbi_servo_begin(&servo, &def, NULL));
    for (int i = 0; i < 1000; i++) { /* a force that nobody paid for, and a hand that goes with it */
        sb_tool_state at = state_at(0, 0, z, 1e-3 * i);
        sbi_servo_call(&servo, &at, i % 10 ? NULL : &frame, &out);
        if (i > 20)
            CHECK(out.force[2] <= 1e-9 + servo.info.energy / (5e-3 * 0.05));
        given += out.force[2] * 5e-5;
        z += 5e-5;
    }
    CHECK(servo.info.limited > 900);
    CHECK(given < 1e-3);
    CHECK(servo.info.energy > -1e-3);
}

/* Organs that move by themselves may push a hand as hard as energy_rate says. */
static void test_energy_rate(void)
{
    sb_haptic_def def = device(5, 500, 2);
    sbi_servo servo;
    sb_wrench_d out;
    sbi_haptic_frame frame = plane_frame(0, 1, 0);
    double given = 0, z = 0;
    def.coupling = 0;
    def.energy_rate = 0.02;
    CHECK_OK(sbi_servo_begin(&servo, &def, NULL));
    for (int i = 0; i < 10000; i++) {
        sb_tool_state at = state_at(0, 0, z, 1e-3 * i);
        sbi_servo_call(&servo, &at, i % 10 ? NULL : &frame, &out);
        given += out.force[2] * 5e-5;
        z += 5e-5;
    }
    CHECK_NEAR(given / 10, 0.02, 0.002); /* of the 0.05 that the force would do */
}

/* Scaled motion and force are a scaled scene, torques and energies included. */
static void test_scales(void)
{
    sb_haptic_def one = device(8, 2000, 5), two;
    sbi_servo a, b;
    seed_t seed = 21;
    const double motion = 0.25, force = 3;
    sbi_haptic_frame frame = random_frame(&seed, 4, 0.4), tiny = frame;
    one.max_torque = 0.4;
    one.coupling_turning = 1;
    two = one; /* the same device on a tissue a fourth of the size, whose forces are a third */
    two.scale_motion = motion;
    two.scale_force = force;
    tiny.pose.position = sbi_d_scale(motion, frame.pose.position);
    for (int c = 0; c < frame.count; c++) {
        sbi_haptic_cluster *k = tiny.clusters + c;
        k->point = sbi_d_scale(motion, k->point);
        k->push /= force;
        k->traction = sbi_d_scale(1 / force, k->traction);
        k->torque = sbi_d_scale(motion / force, k->torque);
        k->stiffness /= motion * force;
        k->tangential /= motion * force;
    }
    CHECK_OK(sbi_servo_begin(&a, &one, NULL));
    CHECK_OK(sbi_servo_begin(&b, &two, NULL));
    for (int i = 0; i < 500; i++) {
        sbi_d3 x = sbi_d_add(frame.pose.position, sbi_d(0.004 * sin(0.02 * i), 0.003 * sin(0.03 * i), -1e-5 * i));
        sb_tool_state at = state_at(x.x, x.y, x.z, 1e-3 * i);
        sb_wrench_d from_a, from_b;
        sbi_turn_to_matrix(sbi_turn_further(frame.pose.rotation, sbi_d(0, 0.1 * sin(0.01 * i), 0)), at.rotation);
        sbi_servo_call(&a, &at, i % 10 ? NULL : &frame, &from_a);
        sbi_servo_call(&b, &at, i % 10 ? NULL : &tiny, &from_b);
        for (int k = 0; k < 3; k++) {
            CHECK_NEAR(from_a.force[k], from_b.force[k], 1e-5);
            CHECK_NEAR(from_a.torque[k], from_b.torque[k], 1e-6);
        }
    }
    CHECK_NEAR(a.info.energy, b.info.energy, 1e-7);
    CHECK_NEAR(sbi_d_norm(sbi_d_sub(sbi_d_scale(motion, a.tool.position), b.tool.position)), 0, 1e-8);
}

/* ---- anything at all ---- */

static double fuzz_number(seed_t *seed, double usual)
{
    const double odd[] = {(double)NAN, (double)INFINITY, -(double)INFINITY, 0, 1e300, -1e300, 1e-300, 1e3, -1e3, 1e9};
    return check_random(seed) < 0.02 ? odd[(int)(10 * check_random(seed))] : check_random_in(seed, -usual, usual);
}

static sbi_d3 fuzz_d3(seed_t *seed, double usual)
{
    double x = fuzz_number(seed, usual), y = fuzz_number(seed, usual);
    return sbi_d(x, y, fuzz_number(seed, usual));
}

static sbi_haptic_frame fuzz_frame(seed_t *seed)
{
    sbi_haptic_frame frame = random_frame(seed, (int)(9 * check_random(seed)), 0.3);
    int odd = check_random(seed) < 0.3;
    for (int c = 0; odd && c < frame.count; c++) {
        sbi_haptic_cluster *k = frame.clusters + c;
        k->point = fuzz_d3(seed, 0.1);
        k->push = fuzz_number(seed, 1);
        k->traction = fuzz_d3(seed, 1);
        k->torque = fuzz_d3(seed, 1);
        k->friction = fabs(fuzz_number(seed, 1));
        k->stiffness = fabs(fuzz_number(seed, 1000));
        k->tangential = fabs(fuzz_number(seed, 1000));
    }
    if (check_random(seed) < 0.05)
        frame.pose.position = fuzz_d3(seed, 1);
    return frame;
}

static sb_tool_state fuzz_state(seed_t *seed, double *time)
{
    sb_tool_state at;
    double clock = check_random(seed);
    sbi_d_pose pose = random_pose(seed, 0.1, 2);
    *time = clock < 0.02 ? fuzz_number(seed, 10) : clock < 0.04 ? *time - 0.5 : clock < 0.06 ? *time : *time + 1e-3;
    at = state_at(fuzz_number(seed, 0.1), fuzz_number(seed, 0.1), fuzz_number(seed, 0.1), *time);
    sbi_turn_to_matrix(pose.rotation, at.rotation);
    for (int i = 0; i < 9; i++)
        at.rotation[i] = check_random(seed) < 0.01 ? fuzz_number(seed, 2) : at.rotation[i];
    sbi_d_put(at.velocity, fuzz_d3(seed, 1));
    sbi_d_put(at.angular_velocity, fuzz_d3(seed, 1));
    if (!(*time - *time == 0))
        *time = 0;
    return at;
}

static void test_fuzz(void)
{
    int rounds = check_quick() ? 10 : 50;
    seed_t seed = 77;
    check_bad_numbers();
    for (int round = 0; round < rounds; round++) {
        sb_haptic_def def = random_device(&seed, 40, round % 5);
        sbi_servo servo;
        double time = 0;
        def.max_torque = round % 3 ? check_random_in(&seed, 0, 1) : 0;
        def.coupling = round % 4 ? -1 : 0;
        def.resolution = round % 2 ? 1e-4 : 0;
        def.scale_motion = round % 7 ? 1 : check_random_in(&seed, 0.01, 100);
        CHECK_OK(sbi_servo_begin(&servo, &def, NULL));
        for (int i = 0; i < 2000; i++) {
            sb_tool_state at = fuzz_state(&seed, &time);
            sbi_haptic_frame frame = fuzz_frame(&seed);
            sb_wrench_d out;
            sb_haptic_info info;
            int bad;
            sbi_servo_call(&servo, &at, check_random(&seed) < 0.2 ? &frame : NULL, &out);
            bad = !(sbi_d_norm(sbi_d_from(out.force)) <= def.max_force * (1 + 1e-12)) ||
                  !(sbi_d_norm(sbi_d_from(out.torque)) <= def.max_torque * (1 + 1e-12));
            info = sbi_servo_info(&servo);
            for (int k = 0; k < 3; k++)
                bad |= info.position[k] - info.position[k] != 0;
            bad |= info.energy - info.energy != 0 || info.gap - info.gap != 0;
            if (!CHECK(!bad))
                return;
        }
        for (int i = 0; i < 400; i++) { /* and afterwards all is well again */
            sb_tool_state at = state_at(0, 0, -0.002, time += 1e-3);
            sbi_haptic_frame frame = plane_frame(-0.001, 0.05, 50);
            sb_wrench_d out;
            sbi_servo_call(&servo, &at, i % 10 ? NULL : &frame, &out);
            if (i == 399 && def.scale_motion == 1)
                CHECK_NEAR(sbi_servo_info(&servo).position[2], -0.002, 0.001);
        }
    }
}

/* ---- hands ---- */

static void hand_run(hand_scene *s, double seconds)
{
    double until = s->time + seconds;
    while (s->time < until)
        hand_call(s);
}

/* Any tissue on any device by the default coupling: a hand with damping 3 N s/m comes to rest in it, to 50 um where its
 * encoder has no steps; else what is left is one step of that, which is more. */
static double no_swing(int hands, int steps)
{
    seed_t seed = 31;
    double worst = 0;
    for (int i = 0; i < hands; i++) {
        sb_haptic_def def = random_device(&seed, 40, 2);
        hand_case is = hand_usual();
        hand_scene s;
        is.tissue = 50 * exp(check_random(&seed) * log(400)); /* 50 .. 20,000 N/m */
        is.period = i % 2 ? 0.01 : 1 / 60.0;
        is.mass = check_random_in(&seed, 0.1, 0.5);
        is.wander = is.tremor = 0;
        is.encoder *= steps;
        def.resolution = is.encoder;
        def.scale_motion = check_random_in(&seed, 0.5, 2);
        def.scale_force = check_random_in(&seed, 0.5, 2);
        if (!hand_begin(&s, &is, &def, seed))
            return 0;
        hand_run(&s, 6);
        hand_watch(&s);
        hand_run(&s, 2);
        worst = fmax(worst, s.high - s.low);
        CHECK(s.high - s.low < (steps ? is.encoder : 50e-6));
        CHECK(s.beyond < 1e-3);
    }
    return worst;
}

static void test_no_swing(void)
{
    double stepped = no_swing(check_quick() ? 20 : 100, 1), smooth = no_swing(check_quick() ? 10 : 50, 0);
    printf("    largest swing %.1f um, %.3f um without steps of the encoder\n", 1e6 * stepped, 1e6 * smooth);
}

/* The forces held between frames instead, in the sheet's stiff tissue: what the planes are for. The bank bounds it. */
static void test_held_force_swings(void)
{
    sb_haptic_def def = device(8, 2000, 2);
    hand_case is = hand_usual();
    hand_scene held, planes;
    def.coupling = 0;
    is.tissue = 600;
    is.damping = 0.6;
    is.wander = is.tremor = 0;
    if (!hand_begin(&planes, &is, &def, 1))
        return;
    is.held = 1;
    hand_begin(&held, &is, &def, 1);
    hand_run(&held, 6);
    hand_run(&planes, 6);
    hand_watch(&held);
    hand_watch(&planes);
    hand_run(&held, 2);
    hand_run(&planes, 2);
    CHECK(held.high - held.low > 10 * (planes.high - planes.low));
}

/* Random hands for a minute on devices and tissues at random, late steps, stalls and uneven calls: the hand gets no
 * more than 10 mJ beyond the bank. */
static void test_passive(void)
{
    seed_t seed = 41;
    double worst = 0;
    for (int i = 0; i < (check_quick() ? 4 : 20); i++) {
        sb_haptic_def def = random_device(&seed, 15, 3);
        hand_case is = hand_usual();
        hand_scene s;
        is.tissue = 50 * exp(check_random(&seed) * log(400));
        is.period = i % 2 ? 0.01 : 1 / 60.0;
        is.jitter = 0.5;
        is.stalls = 0.01;
        is.tick_low = 5e-4;
        is.tick_high = 2.5e-3;
        is.breathing = i % 3 ? 0 : 0.002;
        def.resolution = is.encoder;
        if (!hand_begin(&s, &is, &def, seed))
            return;
        hand_run(&s, 60);
        worst = fmax(worst, s.beyond);
        CHECK(s.beyond < 0.01);
    }
    printf("    most beyond the bank %.2f mJ\n", 1e3 * worst);
}

/* A hand that lets go of the device when a frame arrives, of each in turn: what is left has only the device's mass, and
 * gets no more than 10 mJ beyond the bank; it is not shot away. */
static void test_let_go(void)
{
    seed_t seed = 57;
    double worst = 0, fastest = 0;
    for (int i = 0; i < (check_quick() ? 4 : 20); i++) {
        sb_haptic_def def = random_device(&seed, 15, 3);
        hand_case is = hand_usual();
        hand_scene s;
        is.tissue = 50 * exp(check_random(&seed) * log(400));
        is.period = i % 2 ? 0.01 : 1 / 60.0;
        def.resolution = is.encoder;
        if (!hand_begin(&s, &is, &def, seed))
            return;
        for (int frame = 0; frame < 200; frame++) {
            int64_t before = s.servo.info.frames;
            hand_scene loose;
            double stored;
            while (s.servo.info.frames == before)
                hand_call(&s);
            loose = s;
            loose.is.stiffness = loose.is.damping = 0;
            loose.is.mass = 0.05;
            stored = 0.5 * 0.05 * sbi_d_dot(loose.v, loose.v) + fmax(loose.bank, 0);
            for (int k = 0; k < 300; k++) {
                hand_call(&loose);
                fastest = fmax(fastest, 0.5 * 0.05 * sbi_d_dot(loose.v, loose.v) - stored);
            }
            worst = fmax(worst, loose.beyond);
        }
    }
    printf("    most beyond the bank %.2f mJ, kinetic energy beyond it %.2f mJ\n", 1e3 * worst, 1e3 * fastest);
    CHECK(worst < 0.01);
    CHECK(fastest < 0.01);
}

/* A hand that rests on stiff tissue with its tremor: the bank does not run dry, no force is taken off. */
static void test_rest(void)
{
    sb_haptic_def def = device(8, 2000, 3);
    hand_case is = hand_usual();
    hand_scene s;
    is.tissue = 20000;
    is.wander = 0;
    def.resolution = is.encoder;
    if (!hand_begin(&s, &is, &def, 3))
        return;
    hand_run(&s, check_quick() ? 10 : 60);
    CHECK_INT(s.servo.info.limited, 0);
    CHECK(s.beyond == 0);
}

/* ---- fidelity: the hand's way is prescribed ---- */

enum { STROKE_CALLS = 6000, STROKE_BEGINS = 200 };

/* Presses up to 4.5 mm deep and strokes to and fro. */
static sbi_d3 stroke_at(double frequency, double time)
{
    double phase = 2 * 3.14159265358979 * frequency * time;
    return sbi_d(0.02 * sin(phase), 0, -0.00225 * (1 - cos(0.7 * phase)));
}

/* The push of the tissue stepped by itself along the way, at the times of its steps; between them it is kept. */
static void stroke_steps(const hand_case *is, const sb_haptic_def *def, double frequency, double *pushes, char *steps)
{
    hand_scene s;
    hand_begin(&s, is, def, 1);
    for (int i = 0; i < STROKE_CALLS; i++) {
        steps[i] = 1e-3 * i >= s.next_step - 1e-9;
        if (steps[i]) {
            s.computed = hand_tissue_step(&s, stroke_at(frequency, 1e-3 * i), is->period);
            s.next_step += is->period;
        }
        pushes[i] = fmax(s.computed.clusters[0].push, 0);
    }
}

/* The push that the hand feels along the way. Returns the largest change within a millisecond. */
static double stroke_servo(const hand_case *is, const sb_haptic_def *def, double frequency, double *pushes)
{
    double largest = 0;
    hand_scene s;
    hand_begin(&s, is, def, 1);
    for (int i = 0; i < STROKE_CALLS; i++) {
        sbi_d3 x = stroke_at(frequency, 1e-3 * i);
        sbi_haptic_frame arrives;
        sb_tool_state at = state_at(x.x, x.y, x.z, 1e-3 * i);
        s.time = 1e-3 * i;
        sbi_servo_call(&s.servo, &at, hand_simulate(&s, &arrives), &s.force);
        s.posted = sbi_servo_wanted(&s.servo, 0, &at);
        pushes[i] = s.force.force[2];
        if (i > STROKE_BEGINS)
            largest = fmax(largest, fabs(pushes[i] - pushes[i - 1]));
    }
    return largest;
}

/* Root mean square of the difference where `at` says (NULL: everywhere). */
static double stroke_error(const double *a, const double *b, const char *at)
{
    double sum = 0, count = 0;
    for (int i = STROKE_BEGINS; i < STROKE_CALLS; i++)
        if (!at || at[i]) {
            sum += (a[i] - b[i]) * (a[i] - b[i]);
            count++;
        }
    return sqrt(sum / count);
}

/* Against the same tissue stepped at 1 kHz: the error beyond that of the longer steps themselves, and changes within a
 * millisecond. */
static void fidelity(const char *name, double frequency, double period, double bound)
{
    static double exact[STROKE_CALLS], late[STROKE_CALLS], felt[STROKE_CALLS], held[STROKE_CALLS];
    static char steps[STROKE_CALLS];
    sb_haptic_def def = device(20, 2000, 3);
    hand_case is = hand_usual();
    double peak = 0, least, error, held_error, change;
    def.coupling = 0;
    is.viscosity = 0.002;
    is.period = 1e-3;
    stroke_steps(&is, &def, frequency, exact, steps);
    is.period = period;
    stroke_steps(&is, &def, frequency, late, steps);
    for (int i = 0; i < STROKE_CALLS; i++)
        peak = fmax(peak, exact[i]);
    least = stroke_error(late, exact, steps) / peak;
    change = stroke_servo(&is, &def, frequency, felt) / peak;
    error = stroke_error(felt, exact, NULL) / peak;
    is.held = 1;
    stroke_servo(&is, &def, frequency, held);
    held_error = stroke_error(held, exact, NULL) / peak;
    printf("    %s: error %.2f %% of the peak, of the steps alone %.2f %%, with force held %.2f %%; change in 1 ms "
           "%.2f %%\n",
           name, 100 * error, 100 * least, 100 * held_error, 100 * change);
    CHECK(error < least + bound);
    CHECK(error < 0.5 * held_error);
    CHECK(change < 0.02);
}

static void test_fidelity(void)
{
    fidelity("1 Hz, 100 Hz steps", 1, 0.01, 0.002);
    fidelity("2 Hz, 60 Hz steps", 2, 1 / 60.0, 0.008);
}

CHECK_SUITE(
    haptic_servo, {"rotations there and back", test_turns},
    {"a device's state from OpenHaptics", test_from_openhaptics},
    {"a frame gives back its wrench at its pose", test_frame_at_its_pose},
    {"a plane pushes, sticks, slides and lets go", test_plane}, {"what relaxes in a step", test_relaxing},
    {"unsound frames are told from sound ones", test_unsound_frames},
    {"the coupling against its formula", test_coupling_formula},
    {"tissue and coupling balance with turns and slip", test_coupling_balance},
    {"a coupling that pulls with all it may", test_bounded_pull}, {"the coupling's tangent", test_coupling_tangent},
    {"definitions, defaults and refusals", test_definition}, {"frames blend without a jump", test_blending},
    {"a frame too old fades, and force returns", test_stale}, {"limits of force and of its change", test_limits},
    {"energy of a held force is exact", test_energy_is_exact}, {"an empty bank gives nothing", test_empty_bank},
    {"energy that organs may give", test_energy_rate}, {"scaled motion and force are a scaled scene", test_scales},
    {"any input gives a finite force within limits", test_fuzz}, {"hands come to rest in any tissue", test_no_swing},
    {"a held force swings where planes do not", test_held_force_swings},
    {"random hands get no energy from late steps", test_passive}, {"a hand that lets go", test_let_go},
    {"a resting hand keeps its force", test_rest}, {"force against the same tissue stepped at 1 kHz", test_fidelity});
