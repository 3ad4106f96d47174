/* haptic_servo: the call at 1 kHz. */
#include "haptic_servo.h"

#define SBI_SERVO_TICK 1e-3     /* s: taken for granted where the clock says nothing sensible */
#define SBI_SERVO_SHORTEST 2e-4 /* s between calls that a clock may say */
#define SBI_SERVO_LONGEST 5e-3

#define SBI_SERVO_FAR 1e3   /* m, m/s, rad/s: more is no hand's */
#define SBI_SERVO_RANGE 1e9 /* of fields of the def, and their inverse */

#define SBI_SERVO_FADE 0.1          /* s in which a force goes when frames or states stay away */
#define SBI_SERVO_FASTEST 2e-3      /* s: shortest period of a simulation */
#define SBI_SERVO_SLOWEST 5e-2      /* s: longest */
#define SBI_SERVO_PERIOD (1 / 60.0) /* s: before the first frames */
/* Periods in which the offset of a frame goes. In less the force changes by more than 2 % of its peak within 1 ms after
 * first touch; in more it is farther from what the tissue does. */
#define SBI_SERVO_BLEND 2.5
#define SBI_SERVO_LEARN 0.25 /* share of the newest interval in the period */

/* What the bank holds beyond what springs store is this share of max_force^2/max_stiffness; a debt is remembered up to
 * all of that, so that a device whose position jumps, as when it is set to zero, does not owe for ever. */
#define SBI_BANK_SHARE 0.05
#define SBI_BANK_TICKS 5 /* calls that the bank has to last for */

/* ---- definition ---- */

static sb_result sbi_servo_check_field(const char *name, double value, int may_be_zero, sb_error *error)
{
    if (!sbi_d_within(value, 1.7976931348623157e308))
        return sbi_fail(error, SB_ERROR_NOT_FINITE, "def.%s is not finite", name);
    if (may_be_zero && value == 0)
        return SB_OK;
    if (!(value >= 1 / SBI_SERVO_RANGE) || !(value <= SBI_SERVO_RANGE))
        return sbi_fail(error, SB_ERROR_ARGUMENT, "def.%s %g must be %sin [%g, %g]", name, value,
                        may_be_zero ? "0 or " : "", 1 / SBI_SERVO_RANGE, SBI_SERVO_RANGE);
    return SB_OK;
}

/* Replaces the negative values that stand for defaults. */
static void sbi_servo_fill_in(sb_haptic_def *def)
{
    double lever = def->max_force > 0 ? def->max_torque / def->max_force : 0;
    if (def->max_slew < 0)
        def->max_slew = def->max_force / 2e-3;
    if (def->coupling < 0)
        def->coupling = 0.5 * def->max_stiffness;
    if (def->coupling_turning < 0)
        def->coupling_turning = def->coupling * lever * lever;
    if (def->coupling == 0)
        def->coupling_turning = 0;
}

static sb_result sbi_servo_check_def(const sb_haptic_def *def, sb_error *error)
{
    static const char *const names[] = {"max_force", "max_stiffness",    "scale_motion", "scale_force",
                                        "timeout",   "max_slew",         "max_torque",   "max_damping",
                                        "coupling",  "coupling_turning", "energy_rate",  "resolution"};
    enum { COUNT = sizeof names / sizeof names[0], MAY_BE_ZERO = 6 }; /* from this one on */
    double values[COUNT];
    sb_result result = SB_OK;
    values[0] = def->max_force, values[1] = def->max_stiffness, values[2] = def->scale_motion;
    values[3] = def->scale_force, values[4] = def->timeout, values[5] = def->max_slew;
    values[6] = def->max_torque, values[7] = def->max_damping, values[8] = def->coupling;
    values[9] = def->coupling_turning, values[10] = def->energy_rate;
    values[11] = def->resolution;
    for (int i = 0; i < COUNT && result == SB_OK; i++)
        result = sbi_servo_check_field(names[i], values[i], i >= MAY_BE_ZERO, error);
    return result;
}

SBI_API sb_result sbi_servo_begin(sbi_servo *servo, const sb_haptic_def *def, sb_error *error)
{
    sb_haptic_def full = *def;
    sb_result result;
    if (def->cookie != SBI_HAPTIC_COOKIE)
        return sbi_fail(error, SB_ERROR_ARGUMENT, "the def was not made by sb_default_haptic_def");
    sbi_servo_fill_in(&full);
    result = sbi_servo_check_def(&full, error);
    if (result != SB_OK)
        return result;
    memset(servo, 0, sizeof *servo);
    servo->def = full;
    servo->torque_scale = full.scale_force / full.scale_motion;
    servo->coupling.translation = full.coupling / (full.scale_force * full.scale_motion);
    servo->coupling.rotation = full.coupling_turning / servo->torque_scale;
    servo->lever = full.max_torque / full.max_force;
    servo->own_damping = 0.5 * full.max_stiffness * SBI_SERVO_TICK;
    servo->hand.rotation.w = servo->tool.rotation.w = 1;
    servo->info.period = SBI_SERVO_PERIOD;
    return SB_OK;
}

/* ---- the hand ---- */

SBI_API int sbi_servo_is_sound(const sb_tool_state *in)
{
    int sound = sbi_d3_within(sbi_d_from(in->position), SBI_SERVO_FAR) &&
                sbi_d3_within(sbi_d_from(in->velocity), SBI_SERVO_FAR) &&
                sbi_d3_within(sbi_d_from(in->angular_velocity), SBI_SERVO_FAR) && in->time - in->time == 0;
    for (int i = 0; i < 9; i++)
        sound = sound && sbi_d_within(in->rotation[i], 2);
    return sound;
}

static double sbi_servo_dt(const sbi_servo *servo, double time)
{
    double dt = time - servo->time;
    return servo->has_hand && dt >= SBI_SERVO_SHORTEST && dt <= SBI_SERVO_LONGEST ? dt : SBI_SERVO_TICK;
}

/* The hand's pose in the simulation's space. */
static sbi_d_pose sbi_servo_in_tissue(const sbi_servo *servo, const sbi_d_pose *hand)
{
    sbi_d_pose pose = *hand;
    pose.position = sbi_d_scale(servo->def.scale_motion, hand->position);
    return pose;
}

static sbi_d_wrench sbi_servo_on_hand(const sbi_servo *servo, sbi_d_wrench on_tool)
{
    on_tool.force = sbi_d_scale(servo->def.scale_force, on_tool.force);
    on_tool.torque = sbi_d_scale(servo->torque_scale, on_tool.torque);
    return on_tool;
}

static sbi_d_wrench sbi_wrench_madd(sbi_d_wrench a, double s, sbi_d_wrench b)
{
    a.force = sbi_d_madd(a.force, s, b.force);
    a.torque = sbi_d_madd(a.torque, s, b.torque);
    return a;
}

static sbi_d_wrench sbi_wrench_scale(double s, sbi_d_wrench a)
{
    a.force = sbi_d_scale(s, a.force);
    a.torque = sbi_d_scale(s, a.torque);
    return a;
}

/* ---- the law, in the order of a call ---- */

/* 3. What the hand feels of the frame at a pose, so long (s) after it came. It took a step to come: since then the tool
 * of a step ago goes the way that it went meanwhile. */
static sbi_d_wrench sbi_servo_feel(sbi_servo *servo, const sbi_d_pose *hand, double after)
{
    sbi_d_pose in_tissue = sbi_servo_in_tissue(servo, hand);
    double share = after < servo->info.period ? after / servo->info.period : 1;
    sbi_d_wrench felt;
    sbi_haptic_model_relax(&servo->model, sbi_d_scale(share, servo->way));
    felt = sbi_haptic_model_feel(&servo->model, &servo->coupling, &in_tissue, &servo->tool, &servo->stored);
    servo->stored *= servo->torque_scale;
    servo->info.gap = sbi_d_norm(sbi_d_sub(servo->tool.position, in_tissue.position));
    return sbi_servo_on_hand(servo, felt);
}

/* All that is left of the offsets becomes `sum`: what is not there yet begins to fade. What frames that came early have
 * left of the oldest goes on with the one after it. */
static void sbi_servo_begin_offset(sbi_servo *servo, sbi_d_wrench sum)
{
    enum { LAST = SBI_SERVO_OFFSETS - 1 };
    sbi_servo_offset *offsets = servo->offsets;
    offsets[LAST - 1].wrench = sbi_wrench_madd(offsets[LAST - 1].wrench, 1, offsets[LAST].wrench);
    for (int i = LAST; i > 0; i--) {
        offsets[i] = offsets[i - 1];
        sum = sbi_wrench_madd(sum, -1, offsets[i].wrench);
    }
    offsets[0].wrench = sum;
    offsets[0].left = SBI_SERVO_BLEND * servo->info.period;
}

/* 2. Puts a frame in force; the offset is what the hand felt less what the frame says of the same pose. */
static void sbi_servo_accept(sbi_servo *servo, const sbi_haptic_frame *frame)
{
    double interval = servo->info.age;
    if (!sbi_haptic_frame_is_sound(frame)) {
        servo->info.refused++;
        return;
    }
    if (servo->has_frame && interval <= servo->def.timeout) {
        interval = interval < SBI_SERVO_FASTEST ? SBI_SERVO_FASTEST : interval;
        interval = interval > SBI_SERVO_SLOWEST ? SBI_SERVO_SLOWEST : interval;
        servo->info.period += SBI_SERVO_LEARN * (interval - servo->info.period);
    }
    sbi_haptic_model_set(&servo->model, frame);
    servo->way = sbi_d_sub(servo->tool.position, frame->pose.position);
    servo->info.age = 0;
    sbi_servo_begin_offset(servo, sbi_wrench_madd(servo->shown, -1, sbi_servo_feel(servo, &servo->hand, 0)));
    servo->info.frames++;
    servo->has_frame = 1;
}

/* 1. A state that says nothing: the last wrench, fading. */
static void sbi_servo_refuse(sbi_servo *servo, const sbi_haptic_frame *frame)
{
    servo->info.refused++;
    servo->info.age += SBI_SERVO_TICK;
    if (frame)
        sbi_servo_accept(servo, frame);
    servo->shown = sbi_wrench_scale(1 - SBI_SERVO_TICK / (0.2 * SBI_SERVO_FADE), servo->shown);
}

/* 4. Adds what is left of the offsets after a call. Each goes evenly: no other way changes the force less within a
 * call, which an exponential of the same mean does by 1.7 times as much at first. */
static sbi_d_wrench sbi_servo_blend(sbi_servo *servo, sbi_d_wrench wrench, double dt)
{
    for (int i = 0; i < SBI_SERVO_OFFSETS; i++) {
        sbi_servo_offset *offset = servo->offsets + i;
        double share = offset->left > dt ? 1 - dt / offset->left : 0;
        offset->left = offset->left > dt ? offset->left - dt : 0;
        offset->wrench = sbi_wrench_scale(share, offset->wrench);
        wrench = sbi_wrench_madd(wrench, 1, offset->wrench);
    }
    return wrench;
}

/* 5. Share of the wrench that a frame of this age is worth. */
static double sbi_servo_freshness(const sbi_servo *servo)
{
    double late = servo->info.age - servo->def.timeout;
    if (!servo->has_frame || late >= SBI_SERVO_FADE)
        return 0;
    return late > 0 ? 1 - late / SBI_SERVO_FADE : 1;
}

/* v, at most so long; 0 where it is not finite */
static sbi_d3 sbi_servo_clamp(sbi_d3 v, double limit)
{
    double length = sbi_d_norm(v);
    if (length <= limit)
        return v;
    v = length > 0 ? sbi_d_scale(limit / length, v) : v;
    return sbi_d3_within(v, limit) ? v : sbi_d(0, 0, 0);
}

static sbi_d_wrench sbi_servo_limit(const sbi_servo *servo, sbi_d_wrench wrench)
{
    wrench.force = sbi_servo_clamp(wrench.force, servo->def.max_force);
    wrench.torque = sbi_servo_clamp(wrench.torque, servo->def.max_torque);
    return wrench;
}

/* 6. Limits of the wrench, then of its change. */
static sbi_d_wrench sbi_servo_slew(const sbi_servo *servo, sbi_d_wrench wrench, double dt)
{
    double most = servo->def.max_slew * dt;
    sbi_d_wrench change = sbi_wrench_madd(sbi_servo_limit(servo, wrench), -1, servo->shown);
    change.force = sbi_servo_clamp(change.force, most);
    change.torque = sbi_servo_clamp(change.torque, most * servo->lever);
    return sbi_wrench_madd(servo->shown, 1, change);
}

/* Where the hand is, from a position in steps of an encoder: as far as it went between two neighbouring steps, not to
 * and fro with each of them. The force changes where the hand crosses from one to the next; without this each crossing
 * back and forth would seem to cost the square of a step times the stiffness, and empty the bank of a hand at rest. */
static double sbi_servo_play(double place, double measured, double resolution)
{
    double half = 0.5 * resolution;
    return measured > place + half ? measured - half : measured < place - half ? measured + half : place;
}

static sbi_d3 sbi_servo_place(const sbi_servo *servo, sbi_d3 measured)
{
    const double resolution = servo->def.resolution;
    return sbi_d(sbi_servo_play(servo->place.x, measured.x, resolution),
                 sbi_servo_play(servo->place.y, measured.y, resolution),
                 sbi_servo_play(servo->place.z, measured.z, resolution));
}

/* 7. What the wrench that was held since the last call has done, out of the bank; what the device's own damping took of
 * it; and the bank's bounds. A spring that is held for a tick gives K v^2 T/2 too much, all the time: the device has
 * the damping for that, or it could not render max_stiffness. Without this the bank of a hand at rest would run dry. */
static void sbi_servo_account(sbi_servo *servo, const sbi_d_pose *hand, sbi_d3 velocity, double freshness, double dt)
{
    double spare = SBI_BANK_SHARE * servo->def.max_force * servo->def.max_force / servo->def.max_stiffness;
    double most = freshness * servo->stored + spare, least = -spare / SBI_BANK_SHARE;
    double *e = &servo->info.energy; /* J */
    sbi_d3 place = servo->has_hand ? sbi_servo_place(servo, hand->position) : hand->position;
    if (servo->has_hand)
        *e -= sbi_d_dot(servo->shown.force, sbi_d_sub(place, servo->place)) +
              sbi_d_dot(servo->shown.torque, sbi_turn_between(servo->hand.rotation, hand->rotation));
    servo->place = place;
    *e += servo->own_damping * sbi_d_dot(velocity, velocity) * dt;
    *e = *e < most ? *e : most;
    *e += servo->def.energy_rate * dt;
    *e = *e > least ? *e : least;
}

/* The hand's velocities over the last calls. An encoder's steps are coarse: 55 um within 1 ms are 55 mm/s. */
static void sbi_servo_velocity(sbi_servo *servo, const sbi_d_pose *hand, double dt, sbi_d3 *velocity, sbi_d3 *turning)
{
    double time = dt;
    const sbi_servo_past *oldest;
    int count = servo->past_count;
    *velocity = *turning = sbi_d(0, 0, 0);
    if (count > 0) {
        oldest = servo->past + (servo->past_next + SBI_SERVO_WINDOW - count) % SBI_SERVO_WINDOW;
        for (int i = 1; i < count; i++)
            time += servo->past[(servo->past_next + SBI_SERVO_WINDOW - i) % SBI_SERVO_WINDOW].dt;
        *velocity = sbi_d_scale(1 / time, sbi_d_sub(hand->position, oldest->pose.position));
        *turning = sbi_d_scale(1 / time, sbi_turn_between(oldest->pose.rotation, hand->rotation));
    }
    servo->past[servo->past_next].pose = *hand;
    servo->past[servo->past_next].dt = dt;
    servo->past_next = (servo->past_next + 1) % SBI_SERVO_WINDOW;
    servo->past_count = count < SBI_SERVO_WINDOW ? count + 1 : count;
}

/* 8. Takes off what power exceeds the bank, along the motion; a debt is damped away. */
static sbi_d_wrench sbi_servo_bound_power(sbi_servo *servo, sbi_d_wrench wrench, sbi_d3 v, sbi_d3 w, double dt)
{
    double push = sbi_d_dot(wrench.force, v), turn = sbi_d_dot(wrench.torque, w), e = servo->info.energy;
    double speed = sbi_d_dot(v, v), turning = sbi_d_dot(w, w), lever = servo->lever * servo->lever;
    double excess = push + turn - (e > 0 ? e : 0) / (SBI_BANK_TICKS * dt);
    double given = (push > 0 ? push : 0) + (turn > 0 ? turn : 0), damping = servo->def.max_damping;
    if (!(excess > 0) && !(e < 0))
        return wrench;
    servo->info.limited++;
    if (excess > 0 && push > 0)
        wrench.force = sbi_d_madd(wrench.force, -excess * (push / given) / speed, v);
    if (excess > 0 && turn > 0)
        wrench.torque = sbi_d_madd(wrench.torque, -excess * (turn / given) / turning, w);
    if (e < 0) {
        double all = (speed + lever * turning) * dt;
        damping = -e < damping * all ? -e / all : damping;
        wrench.force = sbi_d_madd(wrench.force, -damping, v);
        wrench.torque = sbi_d_madd(wrench.torque, -damping * lever, w);
    }
    return sbi_servo_limit(servo, wrench);
}

/* ---- the call ---- */

/* Steps 2 to 9 with a sound state. */
static int sbi_servo_follow(sbi_servo *servo, const sb_tool_state *in, const sbi_haptic_frame *frame)
{
    double dt = sbi_servo_dt(servo, in->time), freshness;
    sbi_d3 velocity, turning;
    sbi_d_wrench wrench;
    sbi_d_pose hand;
    hand.position = sbi_d_from(in->position);
    hand.rotation = sbi_turn_from_matrix(in->rotation, servo->hand.rotation);
    servo->info.age += dt;
    if (frame) {
        servo->hand = servo->has_hand ? servo->hand : hand;
        sbi_servo_accept(servo, frame);
    }
    wrench = sbi_servo_feel(servo, &hand, servo->info.age + dt);
    freshness = sbi_servo_freshness(servo);
    wrench = sbi_wrench_scale(freshness, sbi_servo_blend(servo, wrench, dt));
    wrench = sbi_servo_slew(servo, wrench, dt);
    sbi_servo_velocity(servo, &hand, dt, &velocity, &turning);
    sbi_servo_account(servo, &hand, velocity, freshness, dt);
    servo->shown = sbi_servo_bound_power(servo, wrench, velocity, turning, dt);
    servo->hand = hand;
    servo->time = in->time;
    servo->has_hand = 1;
    return freshness == 1;
}

SBI_API int sbi_servo_call(sbi_servo *servo, const sb_tool_state *in, const sbi_haptic_frame *frame, sb_wrench_d *out)
{
    int follows = 0;
    servo->info.calls++;
    if (sbi_servo_is_sound(in))
        follows = sbi_servo_follow(servo, in, frame);
    else
        sbi_servo_refuse(servo, frame);
    sbi_d_put(out->force, servo->shown.force);
    sbi_d_put(out->torque, servo->shown.torque);
    return follows;
}

SBI_API sb_tool_state sbi_servo_wanted(const sbi_servo *servo, int of_hand, const sb_tool_state *in)
{
    sb_tool_state wanted = *in;
    sbi_d_pose pose = of_hand ? sbi_servo_in_tissue(servo, &servo->hand) : servo->tool;
    sbi_d_put(wanted.position, pose.position);
    sbi_turn_to_matrix(pose.rotation, wanted.rotation);
    for (int i = 0; i < 3; i++)
        wanted.velocity[i] *= servo->def.scale_motion;
    return wanted;
}

SBI_API sb_haptic_info sbi_servo_info(const sbi_servo *servo)
{
    sb_haptic_info info = servo->info;
    sbi_d_put(info.position, servo->tool.position);
    sbi_turn_to_matrix(servo->tool.rotation, info.rotation);
    return info;
}
