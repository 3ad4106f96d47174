/* The frame of a fragment in the documentation: a beam, held at one end, is there to be used. FRAGMENT is the
 * fragment's file. */
#include "needle.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int main(void)
{
    sb_error error;
    sb_mesh mesh;
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_real dt = (sb_real)1 / 60;
    int nodes[9] = {0, 5, 10, 15, 20, 25, 30, 35, 40};
    if (sb_mesh_beam(SB_TET4, 4, 2, 2, sb_v3((sb_real)0.4, (sb_real)0.1, (sb_real)0.1), NULL, &mesh, &error) != SB_OK)
        return 1;
    def.mesh = &mesh;
    def.material = sb_material_corotated((sb_real)5e3, (sb_real)0.45, (sb_real)1060);
    def.slack = 1; /* for cuts */
    if (sb_body_create(&def, &body, &error) != SB_OK || sb_body_fix_nodes(body, nodes, 9, SB_XYZ) != SB_OK)
        return 1;
    (void)dt;
    {
#if defined(FRAGMENT)
#include FRAGMENT
#endif
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return 0;
}
