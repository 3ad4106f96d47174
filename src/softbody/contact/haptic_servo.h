/* haptic_servo: the call at 1 kHz: frames and the hand's state in, a wrench out. Internal.
 *
 * Pure: no clock, no thread, no allocation, no loop without a bound. In the order of a call:
 *   1. a state that is not finite is refused: the last wrench again, fading
 *   2. a new frame: what the hand felt less what the frame says there becomes an offset, so that nothing jumps
 *   3. the frame's planes, through the coupling (haptic_model.h)
 *   4. the offset fades, evenly, within two and a half periods of the simulation
 *   5. a frame too old fades; what comes after it returns through the offset
 *   6. limits of force, torque and their change
 *   7. the bank: what the hand has been given and has given, exactly, since a force is held between calls
 *   8. power that the bank does not cover is taken off along the motion; a debt is damped away
 *   9. the wrench is remembered
 *
 * Why a bank: a frame that comes late or changes its stiffness can give energy that nobody put in. The bank holds what
 * the hand put in, up to what springs store at present and a little (SBI_BANK_SHARE): without that bound it would save
 * the work of an hour's strokes, and later pay it out at once. Source: passivity observer and controller of Hannaford
 * and Ryu 2002. */
#ifndef SB_HAPTIC_SERVO_H
#define SB_HAPTIC_SERVO_H

#include "haptic.h"
#include "haptic_model.h"

#define SBI_HAPTIC_COOKIE 0x4a9dcu

enum {
    SBI_SERVO_WINDOW = 4, /* calls over which the hand's velocity is measured */
    SBI_SERVO_OFFSETS = 3 /* frames whose offsets fade at a time: those of SBI_SERVO_BLEND periods */
};

/* What a frame said less than the hand felt when it came, which fades. */
typedef struct sbi_servo_offset {
    sbi_d_wrench wrench;
    double left; /* s until it is gone */
} sbi_servo_offset;

/* Where the hand was. Velocities are found from it and not from the state's: those are in units that nobody checks, and
 * filtered who knows how. */
typedef struct sbi_servo_past {
    sbi_d_pose pose;
    double dt; /* s, of the call */
} sbi_servo_past;

typedef struct sbi_servo {
    sb_haptic_def def; /* with its defaults filled in */
    sbi_haptic_coupling coupling;
    double torque_scale; /* of torques, and of energies, from the tool to the hand */
    double own_damping;  /* N s/m that the device has, since it renders max_stiffness = 2 b/T */
    double lever;        /* m: max_torque over max_force, what turns are weighed with */
    sbi_haptic_model model;
    int has_frame, has_hand;
    double time;                                 /* s, of the last call */
    sbi_d_pose hand;                             /* of the last call, in the device's space */
    sbi_d3 place;                                /* m, of the last call, less the steps of the encoder */
    sbi_d_pose tool;                             /* in the simulation's */
    sbi_d_wrench shown;                          /* on the hand since the last call */
    sbi_servo_offset offsets[SBI_SERVO_OFFSETS]; /* of the last frames, the newest first */
    sbi_d3 way;    /* m: of the tool from the frame's pose to where it was when the frame came */
    double stored; /* J in planes and coupling, as the hand feels them */
    sbi_servo_past past[SBI_SERVO_WINDOW];
    int past_count, past_next;
    sb_haptic_info info;
} sbi_servo;

/* Checks the def (its contact and tool aside), fills in its defaults and begins without a frame. *servo is untouched on
 * failure: SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE name the field. */
SBI_API sb_result sbi_servo_begin(sbi_servo *servo, const sb_haptic_def *def, sb_error *error);

/* 1 when a state is finite and of a size that a hand's can have; others are refused. */
SBI_API int sbi_servo_is_sound(const sb_tool_state *in);
/* One call. frame: what came since the last one, or NULL. *out is finite and within the device's limits whatever comes
 * in. Returns 1 while the wrench follows the hand, 0 while it fades or there is none. */
SBI_API int sbi_servo_call(sbi_servo *servo, const sb_tool_state *in, const sbi_haptic_frame *frame, sb_wrench_d *out);

/* What the simulation is to move its tool to: the last pose on the tool's side of the coupling, or on the hand's where
 * the simulation has the spring itself; the hand's velocities, time and buttons. */
SBI_API sb_tool_state sbi_servo_wanted(const sbi_servo *servo, int of_hand, const sb_tool_state *in);

SBI_API sb_haptic_info sbi_servo_info(const sbi_servo *servo);

#endif /* SB_HAPTIC_SERVO_H */
