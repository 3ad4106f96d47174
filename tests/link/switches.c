/* A trainer's unit that leaves parts out by SB_NO_FILES, SB_NO_GEOMETRY, SB_NO_CONTACT and the like:
 * makes a body, steps it, saves and loads its state in memory. */
#define SB_IMPLEMENTATION
#include "softbody.h"

int main(void)
{
    sb_mesh mesh = {0};
    sb_body *body = NULL;
    sb_body_def def = sb_default_body_def();
    double moment[4096];
    size_t size;
    sb_real lowest;
    if (sb_mesh_beam(SB_TET4, 3, 1, 1, sb_v3((sb_real)0.3, (sb_real)0.1, (sb_real)0.1), NULL, &mesh, NULL) != SB_OK)
        return 1;
    def.mesh = &mesh;
    def.material = sb_material_corotated(50000, (sb_real)0.4, 1000);
    def.gravity = sb_v3(0, 0, (sb_real)-9.81);
    if (sb_body_create(&def, &body, NULL) != SB_OK)
        return 2;
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].x <= 0 && sb_body_fix_nodes(body, &i, 1, SB_XYZ) != SB_OK)
            return 3;
    for (int frame = 0; frame < 10; frame++)
        if (sb_body_step(body, (sb_real)0.01, NULL) != SB_OK)
            return 4;
    lowest = sb_body_displacements(body)[mesh.node_count - 1].z;
    size = sb_body_state_size(body);
    if (!(lowest < 0) || size > sizeof moment || sb_body_state_save(body, moment, size) != SB_OK)
        return 5;
    if (sb_body_step(body, (sb_real)0.01, NULL) != SB_OK || sb_body_state_load(body, moment, size, NULL) != SB_OK)
        return 6;
    if (sb_body_displacements(body)[mesh.node_count - 1].z != lowest)
        return 7;
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return 0;
}
