/* haptic: a hand at a tool: what its two threads call. */
#include "haptic.h"

#include <string.h>

#include "haptic_private.h"

SB_API sb_haptic_def sb_default_haptic_def(void)
{
    sb_haptic_def def;
    memset(&def, 0, sizeof def);
    def.max_slew = -1;
    def.coupling = -1;
    def.coupling_turning = -1;
    def.scale_motion = 1;
    def.scale_force = 1;
    def.timeout = 0.1;
    def.cookie = SBI_HAPTIC_COOKIE;
    return def;
}

SB_API sb_tool_state sb_haptic_from_hd(const double transform[16], const double velocity_mm[3])
{
    const double metre = 1e-3; /* of a millimetre */
    sb_tool_state state;
    memset(&state, 0, sizeof state);
    for (int i = 0; transform && i < 3; i++) {
        state.position[i] = metre * transform[12 + i];
        for (int j = 0; j < 3; j++)
            state.rotation[3 * i + j] = transform[4 * j + i];
    }
    for (int i = 0; velocity_mm && i < 3; i++)
        state.velocity[i] = metre * velocity_mm[i];
    return state;
}

/* ---- made and given back ---- */

static void sbi_haptic_lay_out(sb_haptic *haptic, sbi_arena *arena)
{
    haptic->cluster_of = (int *)sbi_arena_take(arena, (size_t)haptic->contact->max_contacts, sizeof(int));
}

static int sbi_haptic_take_memory(sb_haptic *haptic)
{
    sbi_arena arena = {NULL, 0, 0};
    sbi_haptic_lay_out(haptic, &arena);
    if (arena.overflow)
        return 0;
    haptic->memory = sbi_alloc_zeroed(&haptic->allocator, arena.used, 1);
    if (!haptic->memory)
        return 0;
    arena.base = (unsigned char *)haptic->memory;
    arena.used = 0;
    sbi_haptic_lay_out(haptic, &arena);
    return 1;
}

static sb_result sbi_haptic_check_def(const sb_haptic_def *def, sb_pose *pose, sb_error *error)
{
    if (!SBI_HAS_ATOMICS)
        return sbi_fail(error, SB_ERROR_UNSUPPORTED,
                        "this compiler has no atomics that are known here: define SB_ATOMIC_EXCHANGE and "
                        "SB_ATOMIC_LOAD before the implementation");
    if (!def || def->cookie != SBI_HAPTIC_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by sb_default_haptic_def");
    if (!def->contact)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.contact is NULL: a hand needs the contact of its tool");
    if (sb_contact_reached(def->contact, def->tool, pose, NULL) != SB_OK)
        return sbi_fail(error, SB_ERROR_INDEX, "def.tool is %d: the contact has no such tool", def->tool);
    if (!sbi_body_is_implicit(def->contact->body))
        return sbi_fail(
            error, SB_ERROR_UNSUPPORTED,
            "the body's steps are explicit (SB_CENTRAL_DIFFERENCE): a hand feels the stiffness of the system "
            "that an implicit step solves");
    if (sbi_contact_is_hung(def->contact->tools + def->tool) && (def->coupling >= 0 || def->coupling_turning >= 0))
        return sbi_fail(
            error, SB_ERROR_ARGUMENT,
            "tool %d hangs on a spring, which couples it to the hand: def.coupling and def.coupling_turning "
            "must be left at their defaults",
            def->tool);
    return SB_OK;
}

/* With the spring that a tool hangs on as its coupling, as the hand feels it. */
static sb_haptic_def sbi_haptic_couple(const sb_haptic_def *def)
{
    const sbi_contact_tool *tool = def->contact->tools + def->tool;
    sb_haptic_def full = *def;
    double most = (double)tool->spring.most;
    if (!sbi_contact_is_hung(tool) || !(def->scale_force > 0) || !(def->scale_motion > 0)) /* these are refused */
        return full;
    full.coupling = (double)tool->spring.stiffness * def->scale_force * def->scale_motion;
    full.coupling_turning = (double)tool->spring.turning * def->scale_force / def->scale_motion;
    if (most < def->max_force / def->scale_force)
        full.max_force = most * def->scale_force;
    return full;
}

/* A device that does not turn holds the tool as it stands. */
static void sbi_haptic_begin(sb_haptic *haptic, const sb_pose *pose)
{
    sbi_mailbox_begin(&haptic->frame_box);
    sbi_mailbox_begin(&haptic->report_box);
    haptic->servo.hand.rotation = haptic->servo.tool.rotation = sbi_haptic_pose(pose).rotation;
}

SB_API sb_result sb_haptic_create(const sb_haptic_def *def, sb_haptic **haptic, sb_error *error)
{
    sb_pose pose;
    sb_haptic *made;
    sb_haptic_def full;
    sb_result result = sbi_haptic_check_def(def, &pose, error);
    if (result == SB_OK && !haptic)
        result = sbi_fail(error, SB_ERROR_ARGUMENT, "there is no place for what is made");
    if (result != SB_OK)
        return result;
    made = (sb_haptic *)sbi_alloc_zeroed(&def->contact->allocator, 1, sizeof *made);
    if (!made)
        return sbi_fail(error, SB_ERROR_MEMORY, "no memory for a hand at a tool");
    made->allocator = def->contact->allocator;
    made->contact = def->contact;
    made->tool = def->tool;
    made->hangs = sbi_contact_is_hung(def->contact->tools + def->tool);
    full = sbi_haptic_couple(def);
    result = sbi_servo_begin(&made->servo, &full, error);
    if (made->hangs)
        made->servo.coupling.most = (double)def->contact->tools[def->tool].spring.most;
    if (result == SB_OK && !sbi_haptic_take_memory(made))
        result = sbi_fail(error, SB_ERROR_MEMORY, "no memory for a hand at a tool");
    if (result != SB_OK) {
        sb_haptic_destroy(made);
        return result;
    }
    sbi_haptic_begin(made, &pose);
    *haptic = made;
    return SB_OK;
}

SB_API void sb_haptic_destroy(sb_haptic *haptic)
{
    sb_allocator allocator;
    if (!haptic)
        return;
    allocator = haptic->allocator;
    sbi_free(&allocator, haptic->memory);
    sbi_free(&allocator, haptic);
}

/* ---- the simulation's thread ---- */

static sb_pose sbi_haptic_tool_pose(const sb_tool_state *wanted)
{
    const double *p = wanted->position;
    sbi_turn q = sbi_turn_from_matrix(wanted->rotation, sbi_turn_make(1, 0, 0, 0));
    sb_pose pose;
    pose.position = sb_v3((sb_real)p[0], (sb_real)p[1], (sb_real)p[2]);
    pose.rotation.w = (sb_real)q.w;
    pose.rotation.x = (sb_real)q.x;
    pose.rotation.y = (sb_real)q.y;
    pose.rotation.z = (sb_real)q.z;
    return pose;
}

SB_API sb_result sb_haptic_take(sb_haptic *haptic, sb_tool_state *wanted)
{
    const sbi_haptic_report *report;
    sb_pose pose;
    if (!haptic)
        return SB_ERROR_ARGUMENT;
    haptic->has_report |= sbi_mailbox_take(&haptic->report_box);
    if (wanted)
        memset(wanted, 0, sizeof *wanted);
    if (!haptic->has_report)
        return sb_contact_reached(haptic->contact, haptic->tool, NULL, NULL);
    report = haptic->reports + sbi_mailbox_front(&haptic->report_box);
    if (wanted)
        *wanted = report->wanted;
    pose = sbi_haptic_tool_pose(&report->wanted);
    return sb_contact_move_tool(haptic->contact, haptic->tool, &pose);
}

SB_API sb_result sb_haptic_publish(sb_haptic *haptic)
{
    sb_result result;
    if (!haptic)
        return SB_ERROR_ARGUMENT;
    result = sb_contact_reached(haptic->contact, haptic->tool, NULL, NULL);
    if (result != SB_OK)
        return result;
    sbi_haptic_make_frame(haptic, haptic->frames + sbi_mailbox_back(&haptic->frame_box));
    sbi_mailbox_post(&haptic->frame_box);
    return SB_OK;
}

SB_API sb_haptic_info sb_haptic_get_info(const sb_haptic *haptic)
{
    sb_haptic_info none;
    memset(&none, 0, sizeof none);
    return haptic && haptic->has_report ? haptic->reports[sbi_mailbox_front(&haptic->report_box)].info : none;
}

/* ---- the device's thread ---- */

SB_API int sb_haptic_force(sb_haptic *haptic, const sb_tool_state *in, sb_wrench_d *out)
{
    const sbi_haptic_frame *frame = NULL;
    sbi_haptic_report *report;
    int follows;
    if (out)
        memset(out, 0, sizeof *out);
    if (!haptic || !in || !out)
        return 0;
    if (sbi_mailbox_take(&haptic->frame_box))
        frame = haptic->frames + sbi_mailbox_front(&haptic->frame_box);
    follows = sbi_servo_call(&haptic->servo, in, frame, out);
    if (sbi_servo_is_sound(in)) {
        report = haptic->reports + sbi_mailbox_back(&haptic->report_box);
        report->wanted = sbi_servo_wanted(&haptic->servo, haptic->hangs, in);
        report->info = sbi_servo_info(&haptic->servo);
        sbi_mailbox_post(&haptic->report_box);
    }
    return follows;
}
