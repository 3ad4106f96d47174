/* haptic: definitions, and states of devices. */
#include "haptic.h"
#include "haptic_servo.h"

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
