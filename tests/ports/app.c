/* What a user of a package writes: one step of an organ, and a name of each header. -DAPP_LIBRARY: the functions are a
 * library's. */
#if !defined(APP_LIBRARY)
#define SB_IMPLEMENTATION
#define SB_NO_CUT
#define SB_NO_CONTACT
#define SB_NO_FILES
#endif
#include "softbody.h"
#if defined(APP_LIBRARY)
#include "needle.h"
#include "register.h"
#endif
#include <stdio.h>

int main(void)
{
    sb_mesh mesh;
    sb_body *body = NULL;
    sb_error error;
    if (sb_mesh_organ(SB_TET4, 4, NULL, &mesh, &error))
        return fprintf(stderr, "%s\n", error.message), 1;
    sb_body_def def = sb_default_body_def();
    def.mesh = &mesh;
    def.material = sb_material_corotated(8000, 0.45, 1060);
    def.gravity = sb_v3(0, 0, -9.81);
    int first = 0, failed = sb_body_create(&def, &body, &error) || sb_body_fix_nodes(body, &first, 1, SB_XYZ) ||
                            sb_body_step(body, 0.01, NULL) || !(sb_body_displacements(body)[mesh.node_count - 1].z < 0);
#if defined(APP_LIBRARY)
    failed = failed || ndl_default_needle_def().length < 0 || reg_default_icp_options().max_iterations < 0;
#endif
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    if (failed)
        return fprintf(stderr, "no step\n"), 1;
    return puts(SB_VERSION_STRING) < 0;
}
