/* haptic: forces for a hand at 1 kHz from a simulation that steps at 60 or 100 Hz. */
#ifndef SB_HAPTIC_H
#define SB_HAPTIC_H

#include "contact.h"

/* What is said here to a device is in double, whatever sb_real is. */

/* State of the hand, as the device measures it. */
typedef struct sb_tool_state {
    double position[3];         /* m */
    double rotation[9];         /* row-major, tool to world; all 0: of a device that does not turn */
    double velocity[3];         /* m/s; handed on to the simulation, as is the next */
    double angular_velocity[3]; /* rad/s, in world */
    double time;                /* s, of any clock that does not jump */
    uint32_t buttons;           /* passed on */
} sb_tool_state;

/* A force and a torque about the tool's position, on the hand. */
typedef struct sb_wrench_d {
    double force[3], torque[3]; /* N, N m */
} sb_wrench_d;

/* How a hand is coupled to a tool, and what its device can do. Start from sb_default_haptic_def().
 *
 * The hand's motion times scale_motion is the tool's; the tool's force times scale_force is the hand's. Torques are
 * scaled by scale_force/scale_motion, so that power has one scale. */
typedef struct sb_haptic_def {
    sb_contact *contact;     /* borrowed, destroyed after it */
    int tool;                /* of the contact */
    double max_force;        /* N that the device gives for long, > 0; required */
    double max_torque;       /* N m, >= 0; default 0: the device gives forces only */
    double max_stiffness;    /* N/m and N s/m that it renders at 1 kHz, > 0 and >= 0; required: the device's own */
    double max_damping;      /* figures. With a larger stiffness it hums in a light hand */
    double max_slew;         /* N/s that the force changes by at most; default -1: max_force in 2 ms */
    double coupling;         /* N/m, as the hand feels it, of the spring between hand and tool. 0: rigid, for tissue
                              * softer than the device can render; default -1: 0.5 max_stiffness. Of a tool that hangs
                              * on a spring (sb_tool_def.coupling_stiffness) that spring is the coupling, and no force
                              * exceeds its max_force: leave both at -1 */
    double coupling_turning; /* N m/rad, likewise. 0: rigid, always where coupling is; default -1: coupling times the
                              * square of max_torque/max_force */
    double resolution;       /* m between positions that the encoder tells apart, >= 0; default 0: unknown. Too large a
                              * figure gives energy away, 0 makes a hand that rests for minutes lose force at times */
    double scale_motion;     /* > 0; default 1 */
    double scale_force;      /* > 0; default 1 */
    double timeout;          /* s without a new frame before the force fades, >= 0.01; default 0.1 */
    double energy_rate;      /* W that organs which move by themselves may give to the hand, >= 0; default 0 */
    unsigned cookie;         /* set by sb_default_haptic_def; a def made without it is refused */
} sb_haptic_def;

SB_API sb_haptic_def sb_default_haptic_def(void);

/* What the call at 1 kHz has seen. */
typedef struct sb_haptic_info {
    int64_t calls;      /* since creation */
    int64_t frames;     /* steps of the simulation that reached it */
    int64_t refused;    /* calls with a state, and frames, that are not finite or out of any range */
    int64_t limited;    /* calls in which energy was taken off the hand's motion */
    double energy;      /* J left in the bank: what the hand may be given; < 0: to be taken back */
    double age, period; /* s: of the frame in force, and between frames */
    double gap;         /* m between hand and tool: what the coupling gives way by, of the tool's motion */
    double position[3]; /* m: the tool's pose, which stays on the tissue where the hand goes in: for pictures */
    double rotation[9]; /* row-major */
} sb_haptic_info;

/* ---- a hand at a tool ----
 *
 *     device's thread, at 1 kHz                      simulation's thread, at 60 or 100 Hz
 *         read `in` from the device                      sb_haptic_take(haptic, NULL);
 *         sb_haptic_force(haptic, &in, &out);            sb_body_step(body, dt, NULL);
 *         give out.force to the device                   sb_haptic_publish(haptic);
 *
 * Neither waits for the other: what is new changes hands by one atomic exchange. Between steps the hand feels planes
 * with the stiffness that the step's own system has at the tool, so that the delay of a step does not make it swing,
 * and a bank of energy bounds what it can be given by mistake. */
typedef struct sb_haptic sb_haptic;

/* Takes all memory that is ever needed. SB_ERROR_ARGUMENT, SB_ERROR_NOT_FINITE: the field is named; SB_ERROR_INDEX: the
 * contact has no such tool; SB_ERROR_UNSUPPORTED: the body's steps are explicit, or the compiler has no atomics that
 * are known here, so that SB_ATOMIC_EXCHANGE and SB_ATOMIC_LOAD must be defined before the implementation;
 * SB_ERROR_MEMORY. *haptic is then untouched. */
SB_API sb_result sb_haptic_create(const sb_haptic_def *def, sb_haptic **haptic, sb_error *error);
/* NULL is fine. Neither thread may be in a call. */
SB_API void sb_haptic_destroy(sb_haptic *haptic);

/* Simulation, before the step: the tool is to go where the hand drew it by its last call (sb_contact_move_tool); of a
 * tool on a spring the spring's other end goes where the hand is.
 * wanted (NULL: not asked for): that pose, and the hand's velocities, time and buttons; 0 before the first call. What
 * sb_contact_move_tool returns; SB_ERROR_ARGUMENT: NULL. */
SB_API sb_result sb_haptic_take(sb_haptic *haptic, sb_tool_state *wanted);
/* Simulation, right after the step, before anything else is asked of the body: what the tool feels, and how that
 * changes with its pose. Costs about a tenth of the step: one solution of the step's system, for one stiffness in turn.
 * SB_ERROR_ARGUMENT: NULL; SB_ERROR_INDEX: the tool was removed. */
SB_API sb_result sb_haptic_publish(sb_haptic *haptic);
/* Device, about every 1 ms, one thread at a time: *out is finite and within the def's limits whatever `in` is. 1: it
 * follows the hand; 0: it fades, or there is none. No lock, no allocation, no loop without a bound. */
SB_API int sb_haptic_force(sb_haptic *haptic, const sb_tool_state *in, sb_wrench_d *out);
/* Simulation: as of the last sb_haptic_take. */
SB_API sb_haptic_info sb_haptic_get_info(const sb_haptic *haptic);

/* A device's state from what OpenHaptics gives: HD_CURRENT_TRANSFORM (column-major, mm) and HD_CURRENT_VELOCITY (mm/s).
 * Time and buttons are the caller's to fill in; NULL: all 0. */
SB_API sb_tool_state sb_haptic_from_hd(const double transform[16], const double velocity_mm[3]);

#endif /* SB_HAPTIC_H */
