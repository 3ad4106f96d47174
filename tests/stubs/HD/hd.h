/* The names of HDAPI that examples/haptic_openhaptics.c uses, written anew, before a simulated device: a stylus that
 * goes 20 mm down from 10 mm above its origin within half a second, and stays. For tests, in one unit. */
#ifndef STUB_HD_H
#define STUB_HD_H

#include <pthread.h>
#include <string.h>
#include <time.h>

typedef double HDdouble;
typedef int HDint;
typedef unsigned HHD, HDSchedulerHandle, HDCallbackCode;
typedef struct HDErrorInfo {
    unsigned errorCode;
    int internalErrorCode;
    HHD hHD;
} HDErrorInfo;
#define HDCALLBACK
typedef HDCallbackCode(HDCALLBACK *HDSchedulerCallback)(void *);
enum { HD_CALLBACK_DONE = 0, HD_CALLBACK_CONTINUE = 1, HD_FORCE_OUTPUT = 0x4000, HD_MAX_SCHEDULER_PRIORITY = 0xffff };
enum {
    HD_CURRENT_BUTTONS = 0x2000,
    HD_CURRENT_VELOCITY = 0x2052,
    HD_CURRENT_TRANSFORM = 0x2054,
    HD_CURRENT_FORCE = 0x2700,
    HD_NOMINAL_MAX_STIFFNESS = 0x2602,
    HD_NOMINAL_MAX_DAMPING = 0x2603,
    HD_NOMINAL_MAX_FORCE = 0x2604
};
#define HD_DEFAULT_DEVICE NULL
#define HD_DEVICE_ERROR(error) ((error).errorCode != 0)

typedef struct stub_hd {
    HDSchedulerCallback callback;
    void *user;
    pthread_t thread;
    int stops, calls;
} stub_hd;
static stub_hd stub_device;

static HHD hdInitDevice(const char *name) { return name ? 2 : 1; }
static HHD hdGetCurrentDevice(void) { return 1; }
static void hdDisableDevice(HHD device) { (void)device; }
static void hdBeginFrame(HHD device) { (void)device; }
static void hdEndFrame(HHD device) { stub_device.calls += (int)device; }
static void hdEnable(unsigned what) { (void)what; }
static HDErrorInfo hdGetError(void)
{
    HDErrorInfo none = {0, 0, 1};
    return none;
}
static void hdGetIntegerv(unsigned what, HDint *value) { *value = what == HD_CURRENT_BUTTONS ? 1 : 0; }
static void hdGetDoublev(unsigned what, HDdouble *value)
{
    const double time = 1e-3 * stub_device.calls, share = time < 0.5 ? 2 * time : 1;
    if (what == HD_CURRENT_TRANSFORM) { /* column-major */
        memset(value, 0, 16 * sizeof *value);
        value[0] = value[5] = value[10] = value[15] = 1;
        value[13] = 10 - 14 * share;
    } else if (what == HD_CURRENT_VELOCITY) {
        value[0] = value[2] = 0;
        value[1] = share < 1 ? -28 : 0;
    } else {
        *value = what == HD_NOMINAL_MAX_FORCE ? 3.3 : what == HD_NOMINAL_MAX_STIFFNESS ? 0.9 : 0.002;
    }
}
static void hdSetDoublev(unsigned what, const HDdouble *value) { (void)what, (void)value; }
static HDSchedulerHandle hdScheduleAsynchronous(HDSchedulerCallback callback, void *user, unsigned short priority)
{
    stub_device.callback = callback;
    stub_device.user = user;
    return priority;
}
static void hdUnschedule(HDSchedulerHandle handle) { (void)handle; }
static void *stub_run(void *user)
{
    const struct timespec tick = {0, 1000000};
    while (!__atomic_load_n(&stub_device.stops, __ATOMIC_ACQUIRE) &&
           stub_device.callback(stub_device.user) == HD_CALLBACK_CONTINUE)
        nanosleep(&tick, NULL);
    return user;
}
static void hdStartScheduler(void) { pthread_create(&stub_device.thread, NULL, stub_run, NULL); }
static void hdStopScheduler(void)
{
    __atomic_store_n(&stub_device.stops, 1, __ATOMIC_RELEASE);
    pthread_join(stub_device.thread, NULL);
}

#endif
