/* haptic_openhaptics: a slab of tissue under the stylus of a device with OpenHaptics (HDAPI), as Touch or Phantom.
 *
 *     cc -O3 -I. -I$OPENHAPTICS/include examples/haptic_openhaptics.c -L$OPENHAPTICS/lib -lHD -lHDU -lm
 *     haptic_openhaptics [SECONDS]                           default 30
 *
 * The SDK is not a part of this: without it the program is only compiled, against the names in tests/stubs/HD/hd.h.
 * HDAPI speaks of millimetres and N/mm; y is up. Exit status: 0, 1 the device, 3 a step failed or memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include <HD/hd.h>
#include <math.h>

#include "haptic_slab.h"

enum { EXIT_DEVICE = 1, EXIT_SOLVE = 3 };

/* 1 kHz, in HDAPI's own thread. */
static HDCallbackCode HDCALLBACK serve(void *user)
{
    sb_haptic *haptic = (sb_haptic *)user;
    HDdouble transform[16], velocity[3];
    HDint buttons = 0;
    sb_tool_state in;
    sb_wrench_d out;
    hdBeginFrame(hdGetCurrentDevice());
    hdGetDoublev(HD_CURRENT_TRANSFORM, transform);
    hdGetDoublev(HD_CURRENT_VELOCITY, velocity);
    hdGetIntegerv(HD_CURRENT_BUTTONS, &buttons);
    in = sb_haptic_from_hd(transform, velocity);
    in.time = seconds_now();
    in.buttons = (uint32_t)buttons;
    sb_haptic_force(haptic, &in, &out);
    hdSetDoublev(HD_CURRENT_FORCE, out.force);
    hdEndFrame(hdGetCurrentDevice());
    return HD_DEVICE_ERROR(hdGetError()) ? HD_CALLBACK_DONE : HD_CALLBACK_CONTINUE;
}

/* What the device says that it can do. */
static sb_haptic_def ask_device(void)
{
    sb_haptic_def def = sb_default_haptic_def();
    HDdouble force = 0, stiffness = 0, damping = 0; /* N, N/mm, N s/mm */
    hdGetDoublev(HD_NOMINAL_MAX_FORCE, &force);
    hdGetDoublev(HD_NOMINAL_MAX_STIFFNESS, &stiffness);
    hdGetDoublev(HD_NOMINAL_MAX_DAMPING, &damping);
    def.max_force = force;
    def.max_stiffness = 1e3 * stiffness;
    def.max_damping = 1e3 * damping;
    def.resolution = 5.5e-5; /* m: HDAPI does not tell it; of a Touch, 450 dpi */
    return def;
}

/* 100 steps a second until the time is over. */
static int simulate(slab *s, double seconds)
{
    const double dt = 0.01;
    double begun = seconds_now(), next = begun;
    sb_step_info info;
    sb_wrench wrench = {{0, 0, 0}, {0, 0, 0}};
    double peak = 0;
    while (seconds_now() < begun + seconds) {
        sb_haptic_take(s->haptic, NULL);
        if (sb_body_step(s->body, dt, &info) != SB_OK) {
            fprintf(stderr, "haptic_openhaptics: step: %s\n", info.error.message);
            return EXIT_SOLVE;
        }
        sb_haptic_publish(s->haptic);
        sb_contact_wrench(s->contact, s->tool, &wrench);
        peak = fmax(peak, sb_v3_norm(wrench.force));
        for (next += dt; seconds_now() < next;) /* a game would draw here */
            ;
    }
    printf("%.0f calls, %.0f frames, up to %.2f N\n", (double)sb_haptic_get_info(s->haptic).calls,
           (double)sb_haptic_get_info(s->haptic).frames, peak);
    return 0;
}

static int run(slab *s, double seconds)
{
    HDSchedulerHandle callback;
    sb_haptic_def def = ask_device();
    sb_error error;
    int status;
    if (slab_make(s, 1e4, 1, &def, &error) != SB_OK) {
        fprintf(stderr, "haptic_openhaptics: tissue: %s\n", error.message);
        return EXIT_SOLVE;
    }
    hdEnable(HD_FORCE_OUTPUT);
    callback = hdScheduleAsynchronous(serve, s->haptic, HD_MAX_SCHEDULER_PRIORITY);
    hdStartScheduler();
    status = simulate(s, seconds);
    hdStopScheduler();
    hdUnschedule(callback);
    return status;
}

int main(int argc, char **argv)
{
    double seconds = argc > 1 ? strtod(argv[1], NULL) : 30;
    slab s = {NULL, NULL, NULL, 0};
    HHD device = hdInitDevice(HD_DEFAULT_DEVICE);
    int status;
    if (HD_DEVICE_ERROR(hdGetError())) {
        fprintf(stderr, "haptic_openhaptics: there is no device\n");
        return EXIT_DEVICE;
    }
    status = run(&s, seconds);
    hdDisableDevice(device);
    slab_free(&s);
    return status;
}
