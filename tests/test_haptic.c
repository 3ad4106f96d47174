/* Tests of a hand at a tool: what a step's contacts become for it, the two threads' calls, and a simulated hand that
 * presses into a slab of finite elements. */
#define SB_SPLIT_BUILD
#include "../src/softbody/contact/haptic_private.h"

#include "haptic_hand.h"
#include "scene.h"

#if defined(CHECK_THREADS)
#include <pthread.h>
#include <sched.h>
#endif

/* ---- a slab with a tool above it ---- */

/* Its upper side is at z = -radius: a sphere at the origin touches it in the middle. */
typedef struct slab {
    sb_mesh mesh;
    sb_body *body;
    sb_contact *contact;
    sb_haptic *haptic;
    int tool;
    sb_mesh surface; /* of a slab with a skin */
    sb_embedding *embedding;
    sb_skin *skin;
    scene_memory memory;
} slab;

/* Which surface of it is touched: its own, the same as a skin, or a skin within it whose triangles are others. */
typedef enum slab_kind { SLAB_PLAIN, SLAB_BOUNDARY, SLAB_WITHIN } slab_kind;

static sb_haptic_def slab_device(void)
{
    sb_haptic_def def = sb_default_haptic_def();
    def.max_force = 8;
    def.max_stiffness = 2000;
    def.max_damping = 5;
    def.coupling = 0;
    return def;
}

static sb_tool_def slab_sphere(double friction)
{
    sb_tool_def def = sb_default_tool_def();
    def.radius = REAL(0.012);
    def.friction = REAL(friction);
    def.pose.position.z = REAL(0.0005);
    return def;
}

static void slab_add_skin(slab *s, int cells, slab_kind kind)
{
    sb_embedding_def embed = sb_default_embedding_def();
    sb_boundary boundary;
    sb_mesh mesh;
    if (kind == SLAB_WITHIN) {
        double top = -HUGE_VAL;
        mesh = scene_box(SB_TET4, 3 * cells, 3 * cells, cells, sb_v3(REAL(0.076), REAL(0.076), REAL(0.034)), 0);
        for (int i = 0; i < s->mesh.node_count; i++)
            top = fmax(top, (double)s->mesh.nodes[i].z);
        for (int i = 0; i < mesh.node_count; i++)
            mesh.nodes[i] = sb_v3_add(mesh.nodes[i], sb_v3(REAL(-0.038), REAL(-0.038), REAL(top - 0.03401)));
    } else {
        CHECK_OK(sb_mesh_copy(&s->mesh, NULL, &mesh, NULL));
    }
    CHECK_OK(sb_mesh_boundary(&mesh, 1, NULL, &boundary, NULL));
    CHECK_OK(sb_mesh_copy(&boundary.surface, NULL, &s->surface, NULL));
    sb_boundary_free(&boundary);
    sb_mesh_free(&mesh);
    embed.mesh = &s->mesh;
    embed.surface = &s->surface;
    CHECK_OK(sb_embedding_create(&embed, &s->embedding, NULL));
    CHECK_OK(sb_skin_create(s->embedding, &s->surface, NULL, &s->skin, NULL));
}

static void slab_make_of(slab *s, int cells, slab_kind kind, const sb_tool_def *tool, const sb_haptic_def *device)
{
    sb_body_def body = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    sb_haptic_def def = *device;
    memset(s, 0, sizeof *s);
    s->mesh = scene_box(SB_TET4, 2 * cells, 2 * cells, cells, sb_v3(REAL(0.08), REAL(0.08), REAL(0.04)), 0);
    for (int i = 0; i < s->mesh.node_count; i++)
        s->mesh.nodes[i] = sb_v3_sub(s->mesh.nodes[i], sb_v3(REAL(0.04), REAL(0.04), REAL(0.04) + tool->radius));
    body.mesh = &s->mesh;
    body.material = sb_material_corotated(REAL(5e3), REAL(0.45), 1000);
    body.damping_stiffness = REAL(0.01);
    body.gravity = sb_v3(0, 0, 0);
    body.tolerance = sb_max(REAL(1e-9), 100 * SB_EPSILON);
    body.allocator = scene_allocator(&s->memory);
    CHECK_OK(sb_body_create(&body, &s->body, NULL));
    scene_fix_plane(s->body, &s->mesh, 2, -0.04 - (double)tool->radius, SB_X | SB_Y | SB_Z);
    contact.body = s->body;
    contact.max_iterations = 20;
    if (kind != SLAB_PLAIN)
        slab_add_skin(s, cells, kind);
    contact.skin = s->skin;
    CHECK_OK(sb_contact_create(&contact, &s->contact, NULL));
    CHECK_OK(sb_contact_add_tool(s->contact, tool, &s->tool, NULL));
    def.contact = s->contact;
    def.tool = s->tool;
    CHECK_OK(sb_haptic_create(&def, &s->haptic, NULL));
}

static void slab_make(slab *s, int cells, const sb_tool_def *tool, const sb_haptic_def *device)
{
    slab_make_of(s, cells, SLAB_PLAIN, tool, device);
}

static void slab_free(slab *s)
{
    sb_haptic_destroy(s->haptic);
    sb_contact_destroy(s->contact);
    sb_skin_destroy(s->skin);
    sb_embedding_destroy(s->embedding);
    sb_body_destroy(s->body);
    sb_mesh_free(&s->mesh);
    sb_mesh_free(&s->surface);
    CHECK_INT(s->memory.live, 0);
}

/* A step with the tool moved to (x, 0, z), and its frame. */
static const sbi_haptic_frame *slab_step(slab *s, double x, double z, double dt)
{
    sb_pose pose = sb_default_tool_def().pose;
    pose.position = sb_v3(REAL(x), 0, REAL(z));
    CHECK_OK(sb_contact_move_tool(s->contact, s->tool, &pose));
    CHECK_OK(sb_body_step(s->body, REAL(dt), NULL));
    CHECK_OK(sb_haptic_publish(s->haptic));
    CHECK_INT(sbi_mailbox_take(&s->haptic->frame_box), 1);
    return s->haptic->frames + sbi_mailbox_front(&s->haptic->frame_box);
}

/* ---- frames ---- */

static sbi_d_wrench frame_sum(const sbi_haptic_frame *frame)
{
    sbi_d_wrench sum;
    memset(&sum, 0, sizeof sum);
    for (int c = 0; c < frame->count; c++) {
        const sbi_haptic_cluster *k = frame->clusters + c;
        sbi_d3 force = sbi_d_madd(k->traction, k->push, k->normal);
        sum.force = sbi_d_add(sum.force, force);
        sum.torque = sbi_d_add(sum.torque, sbi_d_cross(sbi_turn_apply(frame->pose.rotation, k->point), force));
        sum.torque = sbi_d_add(sum.torque, k->torque);
    }
    return sum;
}

/* Planes add up to the wrench, of tools that turn and touch on several sides, and what a servo makes of them at their
 * own pose is that wrench. */
static void test_sums(void)
{
    sb_tool_def tools[2] = {slab_sphere(0.6), slab_sphere(0.3)};
    double tolerance = scene_tolerance(1e-12, 1e2);
    tools[1].shape = SB_TOOL_BOX;
    tools[1].half = sb_v3(REAL(0.014), REAL(0.01), REAL(0.012));
    tools[1].pose.rotation = sb_quat_from_rotation_vector(sb_v3(0, REAL(0.5), 0));
    tools[1].radius = REAL(0.003);
    tools[1].pose.position.z = REAL(0.0148);
    for (int i = 0; i < 2; i++) {
        sb_haptic_def device = slab_device();
        int most = 0;
        slab s;
        slab_make(&s, 4, tools + i, &device);
        for (int k = 0; k < 12; k++) {
            sb_pose pose = tools[i].pose;
            sb_wrench wrench = {{0, 0, 0}, {0, 0, 0}};
            sbi_d_wrench sum;
            const sbi_haptic_frame *frame;
            pose.position.z -= REAL(0.0008 * k);
            pose.position.x += REAL(0.0003 * k);
            CHECK_OK(sb_contact_move_tool(s.contact, s.tool, &pose));
            CHECK_OK(sb_body_step(s.body, REAL(0.01), NULL));
            CHECK_OK(sb_haptic_publish(s.haptic));
            CHECK_INT(sbi_mailbox_take(&s.haptic->frame_box), 1);
            frame = s.haptic->frames + sbi_mailbox_front(&s.haptic->frame_box);
            CHECK_OK(sb_contact_wrench(s.contact, s.tool, &wrench));
            CHECK(sbi_haptic_frame_is_sound(frame));
            if (sb_contact_get_info(s.contact).touching == 0)
                continue;
            sum = frame_sum(frame);
            most = frame->count > most ? frame->count : most;
            CHECK_NEAR(sbi_d_norm(sbi_d_sub(sum.force, sbi_d_of(wrench.force))), 0,
                       tolerance * (double)sb_v3_norm(wrench.force));
            CHECK_NEAR(sbi_d_norm(sbi_d_sub(sum.torque, sbi_d_of(wrench.torque))), 0,
                       tolerance * (double)sb_v3_norm(wrench.force) * 0.01);
        }
        printf("    %d planes\n", most);
        CHECK(most >= 1 && most <= SBI_HAPTIC_CLUSTERS);
        slab_free(&s);
    }
}

/* Force on the tool of a step from a saved state to (x, 0, z). */
static sb_vec3 force_after(slab *s, const void *state, size_t size, double x, double z)
{
    sb_wrench wrench = {{0, 0, 0}, {0, 0, 0}};
    CHECK_OK(sb_body_state_load(s->body, state, size, NULL));
    slab_step(s, x, z, 0.01);
    CHECK_OK(sb_contact_wrench(s->contact, s->tool, &wrench));
    return wrench.force;
}

/* The slab's vertical edges go up and down together at each height, and below the sphere neighbours do, more or less:
 * it presses on slaves. */
static void slab_constrain(slab *s)
{
    const double at[4][2] = {{-0.04, -0.04}, {0.04, -0.04}, {-0.04, 0.04}, {0.04, 0.04}};
    for (int i = 0; i < s->mesh.node_count; i++) {
        sb_vec3 x = s->mesh.nodes[i];
        sb_constraint_term terms[3];
        int first = -1, id;
        for (int k = 0; k < s->mesh.node_count; k++)
            if (fabs((double)s->mesh.nodes[k].x - at[0][0]) < 1e-6 &&
                fabs((double)s->mesh.nodes[k].y - at[0][1]) < 1e-6 && fabs((double)(s->mesh.nodes[k].z - x.z)) < 1e-6)
                first = k;
        for (int c = 1; c < 4 && first >= 0 && (double)x.z > -0.04; c++) {
            if (fabs((double)x.x - at[c][0]) > 1e-6 || fabs((double)x.y - at[c][1]) > 1e-6)
                continue;
            terms[0].node = i, terms[0].axis = 2, terms[0].coefficient = 1;
            terms[1].node = first, terms[1].axis = 2, terms[1].coefficient = -1;
            CHECK_OK(sb_body_add_constraint(s->body, terms, 2, 0, &id, NULL));
        }
    }
    for (int i = 0, last = -1, id; i < s->mesh.node_count;
         i++) { /* neighbours on top: each as high as the one before it */
        sb_vec3 x = s->mesh.nodes[i];
        sb_constraint_term terms[2];
        if (fabs((double)x.x) > 0.011 || fabs((double)x.y) > 1e-6 || fabs((double)x.z + 0.04) > 1e-6)
            continue;
        if (last >= 0) {
            terms[0].node = i, terms[0].axis = 2, terms[0].coefficient = 1;
            terms[1].node = last, terms[1].axis = 2, terms[1].coefficient = REAL(-0.9);
            CHECK_OK(sb_body_add_constraint(s->body, terms, 2, 0, &id, NULL));
        }
        last = i;
    }
}

/* Stiffness against differences of whole steps, along the normal and across it. The sphere is large: what its curvature
 * adds is left out, and is about the indentation over its radius. */
static void check_stiffness(int constrained, slab_kind kind)
{
    sb_tool_def tool = slab_sphere(5);
    sb_haptic_def device = slab_device();
    double x = 0, z = 0.0005, way = sizeof(sb_real) == 8 ? 1e-6 : 2e-5;
    sbi_haptic_frame frame;
    size_t size;
    void *state;
    slab s;
    tool.radius = REAL(0.04);
    slab_make_of(&s, 4, kind, &tool, &device);
    if (constrained)
        slab_constrain(&s);
    for (int i = 0; i < 30; i++) {
        z -= i < 10 ? 0.0001 : 0;
        x += i >= 10 && i < 14 ? 0.0001 : 0;
        slab_step(&s, x, z, 0.01);
    }
    size = sb_body_state_size(s.body);
    state = malloc(size);
    if (CHECK(state != NULL) && CHECK_OK(sb_body_state_save(s.body, state, size))) {
        double along, across;
        sb_vec3 at, down, up, aside;
        slab_step(&s, x, z, 0.01);
        frame = *slab_step(&s, x, z, 0.01);
        at = force_after(&s, state, size, x, z);
        down = force_after(&s, state, size, x, z - way);
        up = force_after(&s, state, size, x, z + way);
        aside = force_after(&s, state, size, x + way, z);
        along = (double)(down.z - up.z) /
                (2 * way); /* what touches grows with depth: seen from both sides it does not count */
        across = (double)(at.x - aside.x) / way;
        printf("    %d planes, along %.2f of %.2f N/m, across %.2f of %.2f N/m\n", frame.count,
               frame.clusters[0].stiffness, along, frame.clusters[0].tangential, across);
        CHECK_INT(frame.count, 1);
        /* with constraints a point slips: its bound follows the pressure, which the stiffness leaves out */
        CHECK_NEAR(frame.clusters[0].stiffness / along, 1, scene_tolerance(constrained ? 1e-2 : 2e-3, 2e5));
        CHECK_NEAR(frame.clusters[0].tangential / across, 1, scene_tolerance(constrained ? 5e-2 : 1e-2, 2e5));
    }
    free(state);
    slab_free(&s);
}

static void test_stiffness(void)
{
    check_stiffness(0, SLAB_PLAIN);
    check_stiffness(1, SLAB_PLAIN);
}

/* Before and between touches the frame has the plane of what is nearest. */
static void test_approach(void)
{
    sb_tool_def tool = slab_sphere(0);
    sb_haptic_def device = slab_device();
    const sbi_haptic_frame *frame;
    double stiffness;
    slab s;
    slab_make(&s, 4, &tool, &device);
    frame = slab_step(&s, 0, 0.0005, 0.01);
    if (CHECK_INT(frame->count, 1))
        CHECK_NEAR(frame->clusters[0].push / -frame->clusters[0].stiffness, 0.0005, 0.0003);
    printf("    %.1f N/m foreseen", frame->clusters[0].stiffness);
    for (int i = 0; i < 3; i++)
        frame = slab_step(&s, 0, -0.001, 0.01);
    stiffness = frame->clusters[0].stiffness;
    printf(", %.1f found\n", stiffness);
    CHECK(stiffness > 10);
    for (int i = 0; i < 40; i++)
        frame = slab_step(&s, 0, 0.002, 0.01);
    CHECK_INT(sb_contact_get_info(s.contact).touching, 0);
    if (CHECK_INT(frame->count, 1)) {
        CHECK_NEAR(frame->clusters[0].stiffness, stiffness, 0);
        CHECK_NEAR(frame->clusters[0].normal.z, 1, 0.05);
        CHECK_NEAR(frame->clusters[0].push / -stiffness, 0.002, 0.0005); /* the gap */
    }
    slab_free(&s);
}

/* ---- calls ---- */

static void test_refusals(void)
{
    sb_tool_def tool = slab_sphere(0);
    sb_haptic_def device = slab_device(), def;
    sb_haptic *haptic = NULL;
    sb_error error;
    scene_memory memory;
    slab s;
    slab_make(&s, 4, &tool, &device);
    device.contact = s.contact;
    CHECK_RESULT(sb_haptic_create(NULL, &haptic, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_haptic_create(&device, NULL, &error), SB_ERROR_ARGUMENT);
    def = device, def.contact = NULL;
    CHECK_RESULT(sb_haptic_create(&def, &haptic, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "def.contact") != NULL);
    def = device, def.tool = 1;
    CHECK_RESULT(sb_haptic_create(&def, &haptic, &error), SB_ERROR_INDEX);
    CHECK(strstr(error.message, "def.tool is 1") != NULL);
    def = device, def.max_force = 0;
    CHECK_RESULT(sb_haptic_create(&def, &haptic, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "def.max_force") != NULL);
    for (int i = 1; i <= 2; i++) {
        memory = s.memory;
        s.memory.fail_at = memory.calls + i;
        CHECK_RESULT(sb_haptic_create(&device, &haptic, &error), SB_ERROR_MEMORY);
        CHECK_INT(s.memory.live, memory.live);
    }
    CHECK(haptic == NULL);
    CHECK_OK(sb_contact_remove_tool(s.contact, s.tool));
    CHECK_RESULT(sb_haptic_take(s.haptic, NULL), SB_ERROR_INDEX);
    CHECK_RESULT(sb_haptic_publish(s.haptic), SB_ERROR_INDEX);
    slab_free(&s);
}

static sb_tool_state hand_at(double x, double z, double time)
{
    sb_tool_state state;
    memset(&state, 0, sizeof state);
    state.position[0] = x, state.position[2] = z;
    state.time = time;
    state.buttons = 3;
    return state;
}

/* Without a frame there is no force; when frames stay away it fades. The tool goes where the hand is, with the rotation
 * that it had, since this hand does not turn. */
static void test_without_frames(void)
{
    sb_tool_def tool = slab_sphere(0);
    sb_haptic_def device = slab_device();
    sb_wrench_d out = {{1, 1, 1}, {1, 1, 1}};
    sb_tool_state in = hand_at(0, -0.002, 0), wanted;
    sb_pose pose;
    slab s;
    tool.pose.rotation = sb_quat_from_rotation_vector(sb_v3(0, 0, REAL(0.7)));
    slab_make(&s, 4, &tool, &device);
    CHECK_OK(sb_haptic_take(s.haptic, &wanted));
    CHECK(wanted.buttons == 0 && sb_haptic_get_info(s.haptic).calls == 0);
    for (int i = 0; i < 50; i++) {
        in.time += 1e-3;
        CHECK_INT(sb_haptic_force(s.haptic, &in, &out), 0);
        CHECK(out.force[2] == 0 && out.torque[0] == 0);
    }
    for (int i = 0; i < 5; i++) {
        CHECK_OK(sb_haptic_take(s.haptic, &wanted));
        CHECK_OK(sb_body_step(s.body, REAL(0.01), NULL));
        CHECK_OK(sb_haptic_publish(s.haptic));
    }
    CHECK_INT(wanted.buttons, 3);
    CHECK_INT(sb_haptic_get_info(s.haptic).calls, 50);
    CHECK_OK(sb_contact_reached(s.contact, s.tool, &pose, NULL));
    CHECK_NEAR(pose.position.z, -0.002, 1e-7);
    CHECK_NEAR(sb_quat_dot(pose.rotation, tool.pose.rotation), 1, 1e-6);
    for (int i = 0; i < 300; i++) {
        in.time += 1e-3;
        CHECK_INT(sb_haptic_force(s.haptic, &in, &out), i < 100);
        if (i == 90)
            CHECK(out.force[2] > 0.1);
    }
    CHECK_NEAR(out.force[2], 0, 1e-12);
    check_bad_numbers();
    in.position[0] = (double)NAN;
    CHECK_INT(sb_haptic_force(s.haptic, &in, &out), 0);
    CHECK(out.force[0] - out.force[0] == 0);
    CHECK_OK(sb_haptic_take(s.haptic, &wanted));
    CHECK(wanted.position[0] == 0);
    slab_free(&s);
}

/* ---- a hand that presses ---- */

typedef struct press_result {
    double swing, touch, jump, peak, beyond,
        frames; /* touch, jump: largest change in a call at first touch, and later */
} press_result;

enum {
    TOUCH_FRAMES = 3,
    PRESS_CALLS = 2000,
    PRESS_EXACT = 150
}; /* frames that first touch takes; calls; those
    * around it that are compared with steps of 1 ms */

/* What the device measured call by call, and the first with a force. */
typedef struct press_path {
    sbi_d3 places[PRESS_CALLS];
    int count, touched;
} press_path;

/* The hand presses 4 mm deep for `seconds`; steps of `period` whose frames come one step late. */
static press_result press(slab *s, hand_scene *hand, double period, double seconds, press_path *path)
{
    press_result result;
    double next = 0, touched = -1;
    int computed = 0, calls;
    memset(&result, 0, sizeof result);
    path->count = path->touched = 0;
    hand_watch(hand);
    while (hand->time < seconds) {
        sb_wrench_d before = hand->force;
        sb_tool_state in = hand_sense(hand);
        if (hand->time >= next) {
            if (computed)
                CHECK_OK(sb_haptic_publish(s->haptic));
            CHECK_OK(sb_haptic_take(s->haptic, NULL));
            calls = s->memory.calls;
            CHECK_OK(sb_body_step(s->body, REAL(period), NULL));
            CHECK_INT(s->memory.calls, calls);
            computed = 1;
            next += period;
        }
        sb_haptic_force(s->haptic, &in, &hand->force);
        if (path->count < PRESS_CALLS)
            path->places[path->count++] = sbi_d_from(in.position);
        hand->servo.stored = s->haptic->servo.stored;
        hand_account(hand, &before);
        if (touched < 0 && hand->force.force[2] > 0)
            touched = hand->time, path->touched = path->count;
        if (touched < 0 || hand->time < touched + (double)TOUCH_FRAMES * period) {
            result.touch = fmax(result.touch, hand->jump);
            hand->jump = 0;
        }
        if (hand->time < seconds - 0.5)
            hand_watch(hand);
    }
    result.swing = hand->high - hand->low;
    result.jump = hand->jump;
    result.peak = hand->peak;
    result.beyond = hand->beyond;
    result.frames = (double)s->haptic->servo.info.frames;
    return result;
}

/* The force of the same tissue in steps of 1 ms along a path: largest changes in one around first touch, of `touch`
 * calls, and after it (N). */
static void press_exactly(slab_kind kind, const press_path *path, int touch, double changes[2])
{
    int first = path->touched > 6 ? path->touched - 6 : 0;
    sb_tool_def tool = slab_sphere(0.3);
    sb_haptic_def device = slab_device();
    sb_vec3 before = {0, 0, 0};
    slab s;
    changes[0] = changes[1] = 0;
    tool.pose.position.z = REAL(path->places[first].z);
    slab_make_of(&s, 4, kind, &tool, &device);
    for (int i = first; i < first + PRESS_EXACT && i < path->count; i++) {
        sb_pose pose = tool.pose;
        sb_wrench felt;
        pose.position = sb_v3(REAL(path->places[i].x), REAL(path->places[i].y), REAL(path->places[i].z));
        CHECK_OK(sb_contact_move_tool(s.contact, s.tool, &pose));
        CHECK_OK(sb_body_step(s.body, REAL(1e-3), NULL));
        CHECK_OK(sb_contact_wrench(s.contact, s.tool, &felt));
        changes[i >= path->touched + touch] =
            fmax(changes[i >= path->touched + touch], (double)sb_v3_norm(sb_v3_sub(felt.force, before)));
        before = felt.force;
    }
    slab_free(&s);
}

/* No swing that grows, no jump that is felt, no energy out of nothing. The hand comes at 5 cm/s. Along its way the same
 * tissue in steps of 1 ms changes by a fifth of the peak within 1 ms at first touch, and later by 1.3 %: so much is
 * physics. Of the changes below most is a step of the encoder, which is some 4 % of this peak, and which tissue in
 * steps of 1 ms makes far more of; the last two hands have none. */
static void check_press(slab_kind kind, int first)
{
    const double rates[4] = {60, 100, 60, 100};
    for (int i = first; i < 4; i++) {
        sb_tool_def tool = slab_sphere(0.3);
        sb_haptic_def device = slab_device();
        hand_case is = hand_usual();
        hand_scene hand;
        press_result result;
        static press_path path;
        double exact[2] = {0, 0};
        int calls;
        slab s;
        is.tremor = 0;
        if (i > 1)
            is.encoder = device.resolution = 0;
        is.wander = 0;
        slab_make_of(&s, 4, kind, &tool, &device);
        CHECK(hand_begin(&hand, &is, &device, 7));
        calls = s.memory.calls;
        result = press(&s, &hand, 1 / rates[i], 1.5, &path);
        CHECK_INT(s.memory.calls, calls);
        printf("    %g Hz, encoder %g um: %.2f N, swing %.2f um, 1 ms change %.2f %% of the peak, at first touch %.2f "
               "%%, beyond the bank "
               "%.3f mJ\n",
               rates[i], 1e6 * is.encoder, result.peak, 1e6 * result.swing, 100 * result.jump / result.peak,
               100 * result.touch / result.peak, 1e3 * result.beyond);
        CHECK(result.peak > 0.3);
        CHECK(result.swing < 50e-6);
        if (i % 2) { /* at 100 Hz */
            press_exactly(kind, &path, (int)(1000 * TOUCH_FRAMES / rates[i]), exact);
            printf("    in steps of 1 ms along that way %.2f %%, at first touch %.2f %%\n",
                   100 * exact[1] / result.peak, 100 * exact[0] / result.peak);
            CHECK(result.touch < 0.3 * exact[0]);
            CHECK(result.jump < exact[1] + (is.encoder > 0 ? 0.02 : 0.01) * result.peak);
        }
        CHECK(result.jump < (is.encoder > 0 ? 0.06 : 0.02) * result.peak); /* of a force held over a step: a quarter */
        CHECK(result.touch < (is.encoder > 0 ? 0.05 : 0.04) * result.peak);
        CHECK(result.beyond < 1e-3);
        CHECK(result.frames > 1.5 * rates[i] - 5);
        slab_free(&s);
    }
}

static void test_press(void) { check_press(SLAB_PLAIN, 0); }

/* Hands of other masses, springs and depths, without an encoder. */
static void test_press_of_many(void)
{
    unsigned long long seed = 99;
    double most = 0;
    for (int i = 0; i < (check_quick() ? 2 : 6); i++) {
        sb_tool_def tool = slab_sphere(0.3);
        sb_haptic_def device = slab_device();
        hand_case is = hand_usual();
        hand_scene hand;
        press_result result;
        static press_path path;
        slab s;
        is.tremor = is.wander = is.encoder = device.resolution = 0;
        is.depth = check_random_in(&seed, 0.002, 0.006);
        is.stiffness = check_random_in(&seed, 200, 500);
        is.mass = check_random_in(&seed, 0.2, 0.5);
        is.damping = check_random_in(&seed, 1, 5);
        slab_make_of(&s, 4, SLAB_PLAIN, &tool, &device);
        CHECK(hand_begin(&hand, &is, &device, 7));
        result = press(&s, &hand, 0.01, 1, &path);
        CHECK(result.peak > 0.1);
        CHECK(result.jump < 0.02 * result.peak);
        CHECK(result.touch < 0.05 * result.peak);
        CHECK(result.beyond < 1e-3);
        most = fmax(most, result.jump / result.peak);
        slab_free(&s);
    }
    printf("    1 ms change at most %.2f %% of the peak\n", 100 * most);
}

/* ---- the same on a skin ---- */

/* A skin that is the boundary is felt as that. */
static void compare_frames(void)
{
    sb_tool_def tool = slab_sphere(0.3);
    sb_haptic_def device = slab_device();
    double worst = 0, most = 0;
    slab plain, skinned;
    slab_make(&plain, 4, &tool, &device);
    slab_make_of(&skinned, 4, SLAB_BOUNDARY, &tool, &device);
    for (int i = 0; i < 20; i++) {
        double x = i < 10 ? 0 : 0.0003 * (i - 10), z = 0.0005 - 0.0003 * (i < 10 ? i : 10);
        sbi_haptic_frame one = *slab_step(&plain, x, z, 0.01), two = *slab_step(&skinned, x, z, 0.01);
        sbi_d3 force = frame_sum(&one).force;
        most = fmax(most, sbi_d_norm(force));
        worst = fmax(worst, sbi_d_norm(sbi_d_sub(force, frame_sum(&two).force)));
        if (one.count == 1 && two.count == 1)
            CHECK_NEAR(two.clusters[0].stiffness / one.clusters[0].stiffness, 1, scene_tolerance(1e-6, 1e6));
    }
    printf("    a skin that is the boundary: forces off by %.1e of %.3f N\n", worst, most);
    CHECK(most > 0.1 && worst < scene_tolerance(1e-8, 1e5) * most);
    slab_free(&plain);
    slab_free(&skinned);
}

static void test_skin(void)
{
    compare_frames();
    check_stiffness(0, SLAB_WITHIN);
    check_press(SLAB_WITHIN, check_quick() ? 3 : 2);
}

/* ---- a tool on a spring ---- */

/* The hand rests at z while the simulation steps; its last force. */
static sb_wrench_d hung_rest(slab *s, double z, int steps, double *time)
{
    sb_wrench_d out;
    memset(&out, 0, sizeof out);
    for (int i = 0; i < steps; i++) {
        for (int k = 0; k < 10; k++, *time += 1e-3) {
            sb_tool_state in = hand_at(0, z, *time);
            CHECK_INT(sb_haptic_force(s->haptic, &in, &out), *time > 0.0095);
        }
        CHECK_OK(sb_haptic_take(s->haptic, NULL));
        CHECK_OK(sb_body_step(s->body, REAL(0.01), NULL));
        CHECK_OK(sb_haptic_publish(s->haptic));
    }
    return out;
}

/* What the hand feels of the spring after a step from a saved state with it at z. */
static double hung_pull(slab *s, const void *state, size_t size, double z)
{
    sb_wrench spring;
    CHECK_OK(sb_body_state_load(s->body, state, size, NULL));
    slab_step(s, 0, 0.5 * z, 0.01);
    CHECK_OK(sb_contact_coupling(s->contact, s->tool, &spring));
    return -2 * (double)spring.force.z;
}

/* The hand feels the spring that the tool hangs on, stretched as in the simulation, and between steps that spring in a
 * row with the surface: as steps do. */
static void test_hung(void)
{
    const double way = sizeof(sb_real) == 8 ? 1e-6 : 2e-5;
    sb_haptic_def device = slab_device();
    sb_tool_def tool = slab_sphere(5);
    double time = 0, at, between, steps, held;
    size_t size;
    void *state;
    sb_haptic *haptic = NULL;
    sb_tool_state in;
    sb_wrench_d out;
    sb_wrench spring;
    slab s;
    device.coupling = -1;
    device.scale_motion = 0.5;
    device.scale_force = 2;
    tool.radius = REAL(0.04); /* large: what its curvature adds is left out */
    tool.coupling_stiffness = 300;
    tool.max_force = 2;
    slab_make(&s, 4, &tool, &device);
    at = hung_rest(&s, -0.008, 120, &time).force[2];
    CHECK_OK(sb_contact_coupling(s.contact, s.tool, &spring));
    CHECK(at > 0.5);
    CHECK_NEAR(at / (-2 * (double)spring.force.z), 1, scene_tolerance(1e-6, 1e3));
    in = hand_at(0, -0.008 - way, time);
    sb_haptic_force(s.haptic, &in, &out);
    between = (out.force[2] - at) / way;
    size = sb_body_state_size(s.body);
    state = malloc(size);
    CHECK_OK(sb_body_state_save(s.body, state, size));
    steps = (hung_pull(&s, state, size, -0.008 - way) - hung_pull(&s, state, size, -0.008 + way)) / (2 * way);
    free(state);
    printf("    on a spring of 300 N/m: %.2f of %.2f N/m\n", between, steps);
    CHECK_NEAR(between / steps, 1, scene_tolerance(1e-2, 1e5));
    held = hung_rest(&s, -0.5, 60, &time).force[2]; /* as far as the spring pulls */
    CHECK_NEAR(held, 2 * 2, 0.01);
    device.contact = s.contact;
    device.tool = s.tool;
    device.coupling = 500;
    CHECK_RESULT(sb_haptic_create(&device, &haptic, NULL), SB_ERROR_ARGUMENT);
    slab_free(&s);
}

/* ---- two threads ---- */

#if defined(CHECK_THREADS)
typedef struct threads_hand {
    sb_haptic *haptic;
    int wrong;
} threads_hand;

static void *threads_call(void *user)
{
    threads_hand *t = (threads_hand *)user;
    for (int i = 0; i < 20000; i++) {
        double share = i < 5000 ? i / 5000.0 : 1;
        sb_tool_state in = hand_at(0, 0.001 - 0.004 * share, 1e-3 * i);
        sb_wrench_d out;
        sb_haptic_force(t->haptic, &in, &out);
        t->wrong += !(fabs(out.force[2]) <= 8);
        if (i % 20 == 0)
            sched_yield();
    }
    return NULL;
}

/* The device's calls on a thread of their own, while the simulation steps. */
static void test_threads(void)
{
    sb_tool_def tool = slab_sphere(0.3);
    sb_haptic_def device = slab_device();
    threads_hand hand;
    pthread_t thread;
    slab s;
    slab_make(&s, 3, &tool, &device);
    hand.haptic = s.haptic;
    hand.wrong = 0;
    if (CHECK_INT(pthread_create(&thread, NULL, threads_call, &hand), 0)) {
        for (int i = 0; i < 60; i++) {
            CHECK_OK(sb_haptic_take(s.haptic, NULL));
            CHECK_OK(sb_body_step(s.body, REAL(0.01), NULL));
            CHECK_OK(sb_haptic_publish(s.haptic));
            CHECK(sb_haptic_get_info(s.haptic).refused == 0);
        }
        CHECK_INT(pthread_join(thread, NULL), 0);
        CHECK_INT(hand.wrong, 0);
        CHECK_OK(sb_haptic_take(s.haptic, NULL));
        CHECK_INT(sb_haptic_get_info(s.haptic).calls, 20000);
    }
    slab_free(&s);
}
#define HAPTIC_THREADS                                                                                                 \
    {                                                                                                                  \
        "threads", test_threads                                                                                        \
    }
#else
#define HAPTIC_THREADS                                                                                                 \
    {                                                                                                                  \
        NULL, NULL                                                                                                     \
    } /* for make test-tsan */
#endif

CHECK_SUITE(haptic, {"planes add up to the wrench", test_sums},
            {"stiffness against differences of steps", test_stiffness}, {"the plane of what is nearest", test_approach},
            {"refusals", test_refusals}, {"no frames", test_without_frames}, {"a hand presses into a slab", test_press},
            {"so do hands of many kinds", test_press_of_many}, {"on a skin", test_skin}, {"on a spring", test_hung},
            HAPTIC_THREADS);
