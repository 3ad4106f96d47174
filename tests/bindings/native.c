/* What tests/bindings.py and Drive.cs do by the headers: the hash of the state must be the same. */
#define SB_IMPLEMENTATION
#include "softbody.h"
#include <stdio.h>

int main(void)
{
    sb_mesh mesh = {0};
    sb_body *body = NULL;
    sb_body_def def = sb_default_body_def();
    int held[3] = {0, 7, 100};
    if (sb_mesh_organ(SB_TET4, 12, NULL, &mesh, NULL) != SB_OK)
        return 1;
    def.mesh = &mesh;
    def.material = sb_material_corotated(8000, 0.45, 1060);
    def.gravity = sb_v3(0, 0, -9.81);
    if (sb_body_create(&def, &body, NULL) != SB_OK || sb_body_hold(body, held, 3, SB_XYZ, NULL) != SB_OK)
        return 1;
    for (int frame = 0; frame < 10; frame++)
        if (sb_body_step(body, 1.0 / 60, NULL) != SB_OK)
            return 1;
    printf("%llu\n", (unsigned long long)sb_body_state_hash(body));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return 0;
}
