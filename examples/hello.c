/* hello [ORGAN.vtk]: an organ that is held at its back sags under gravity for a second.    cc hello.c -lm */
#include <stdio.h>
#define SB_IMPLEMENTATION
#include "softbody.h"
int main(int argc, char **argv)
{
    sb_mesh mesh; sb_body *body; sb_step_info info; sb_error err;
    sb_vec3 low, high; sb_mat3 sigma; sb_real sag = 0, stress = 0;
    sb_body_def def = sb_default_body_def();
    def.mesh = &mesh;
    def.material = sb_material_corotated(8000, 0.45, 1060); /* E (Pa), Poisson's ratio, density (kg/m^3) */
    def.gravity = sb_v3(0, 0, -9.81);
    if ((argc > 1 ? sb_mesh_load(&mesh, argv[1], NULL, &err)
                  : sb_mesh_organ(SB_TET4, 12, NULL, &mesh, &err)) || sb_body_create(&def, &body, &err))
        return fprintf(stderr, "hello: %s:%d: %s\n", err.file, err.line, err.message), 1;
    sb_mesh_bounds(&mesh, &low, &high);
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].y > high.y - (high.y - low.y) / 3 && sb_body_fix_nodes(body, &i, 1, SB_XYZ))
            return fprintf(stderr, "hello: node %d cannot be fixed\n", i), 1;
    for (int frame = 0; frame < 60; frame++)
        if (sb_body_step(body, 1.0 / 60, &info))
            return fprintf(stderr, "hello: frame %d: %s\n", frame, info.error.message), 1;
    for (int i = 0; i < mesh.node_count; i++)
        sag = sb_max(sag, -sb_body_displacements(body)[i].z);
    for (int i = 0; i < mesh.element_count; i++)
        stress = sb_body_stress(body, i, 0, &sigma) ? stress : sb_max(stress, sb_von_mises(sigma));
    printf("it sags by %.1f mm, the largest von Mises stress is %.0f Pa\n", 1e3 * sag, stress);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}
