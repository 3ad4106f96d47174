// haptic_chai3d: a slab of tissue under a device that CHAI3D knows.
//
//     c++ -std=c++11 -O3 -I. -I$CHAI3D/src examples/haptic_chai3d.cpp -L$CHAI3D/lib -lchai3d ...
//     haptic_chai3d [SECONDS]                                default 30
//
// CHAI3D is not a part of this: without it the program is only compiled, against the names in tests/stubs/chai3d.h.
// CHAI3D speaks of metres and newtons; z is up. Exit status: 0, 1 the device, 3 a step failed or memory is short.
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "chai3d.h"
#include "haptic_slab.h"

using namespace chai3d;

namespace {

enum { EXIT_DEVICE = 1, EXIT_SOLVE = 3 };

cGenericHapticDevicePtr device;
slab scene;
volatile bool runs = true, has_ended = false; // as CHAI3D's own examples end their threads

void put(const cVector3d &from, double *to)
{
    to[0] = from.x();
    to[1] = from.y();
    to[2] = from.z();
}

// 1 kHz, in a thread of CHAI3D's.
void serve()
{
    while (runs) {
        cVector3d position, velocity, turning;
        cMatrix3d rotation;
        unsigned int buttons = 0;
        sb_tool_state in = sb_haptic_from_hd(NULL, NULL);
        sb_wrench_d out;
        device->getPosition(position);
        device->getRotation(rotation);
        device->getLinearVelocity(velocity);
        device->getAngularVelocity(turning);
        device->getUserSwitches(buttons);
        put(position, in.position);
        put(velocity, in.velocity);
        put(turning, in.angular_velocity);
        for (unsigned int i = 0; i < 9; i++)
            in.rotation[i] = rotation(i / 3, i % 3);
        in.time = seconds_now();
        in.buttons = buttons;
        sb_haptic_force(scene.haptic, &in, &out);
        device->setForceAndTorqueAndGripperForce(cVector3d(out.force[0], out.force[1], out.force[2]),
                                                 cVector3d(out.torque[0], out.torque[1], out.torque[2]), 0.0);
    }
    has_ended = true;
}

// What the device says that it can do.
sb_haptic_def ask_device()
{
    const cHapticDeviceInfo info = device->getSpecifications();
    sb_haptic_def def = sb_default_haptic_def();
    def.max_force = info.m_maxLinearForce;
    def.max_torque = info.m_actuatedRotation ? info.m_maxAngularTorque : 0;
    def.max_stiffness = info.m_maxLinearStiffness;
    def.max_damping = info.m_maxLinearDamping;
    def.resolution = 1e-5; // m: CHAI3D does not tell it; take your device's
    return def;
}

// 100 steps a second until the time is over.
int simulate(double seconds)
{
    const double dt = 0.01, begun = seconds_now();
    double peak = 0;
    for (int i = 1; seconds_now() < begun + seconds; i++) {
        sb_step_info info;
        sb_wrench wrench = {{0, 0, 0}, {0, 0, 0}};
        double rest;
        sb_haptic_take(scene.haptic, NULL);
        if (sb_body_step(scene.body, dt, &info) != SB_OK) {
            fprintf(stderr, "haptic_chai3d: step: %s\n", info.error.message);
            return EXIT_SOLVE;
        }
        sb_haptic_publish(scene.haptic);
        sb_contact_wrench(scene.contact, scene.tool, &wrench);
        peak = fmax(peak, sb_v3_norm(wrench.force));
        rest = begun + i * dt - seconds_now();
        if (rest > 0)
            cSleepMs((unsigned int)(1e3 * rest));
    }
    printf("%.0f calls, %.0f frames, up to %.2f N\n", (double)sb_haptic_get_info(scene.haptic).calls,
           (double)sb_haptic_get_info(scene.haptic).frames, peak);
    return 0;
}

int run(double seconds)
{
    const sb_haptic_def def = ask_device();
    sb_error error;
    cThread thread;
    int status;
    if (slab_make(&scene, 1e4, 2, &def, &error) != SB_OK) {
        fprintf(stderr, "haptic_chai3d: tissue: %s\n", error.message);
        return EXIT_SOLVE;
    }
    thread.start(serve, CTHREAD_PRIORITY_HAPTICS);
    status = simulate(seconds);
    runs = false;
    while (!has_ended)
        cSleepMs(1);
    return status;
}

} // namespace

int main(int argc, char **argv)
{
    const double seconds = argc > 1 ? strtod(argv[1], NULL) : 30;
    cHapticDeviceHandler handler;
    int status;
    if (!handler.getDevice(device, 0) || !device->open()) {
        fprintf(stderr, "haptic_chai3d: there is no device\n");
        return EXIT_DEVICE;
    }
    device->calibrate();
    status = run(seconds);
    device->close();
    slab_free(&scene);
    return status;
}
