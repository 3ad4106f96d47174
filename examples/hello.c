/* hello [ORGAN.vtk]: an organ, held at its back, sags under gravity for a second.    cc hello.c -lm */
#define SB_IMPLEMENTATION
#include "softbody.h"
#include <stdio.h>

static int fail(const sb_error *e)
{
    fprintf(stderr, "%s:%d: %s\nusage: hello [ORGAN.vtk], in metres\n", e->file, e->line, e->message);
    return 1;
}

int main(int argc, char **argv)
{
    sb_mesh mesh;
    sb_body *body = NULL;
    sb_error error;
    if ((argc > 1 ? sb_mesh_load(&mesh, argv[1], NULL, &error) : sb_mesh_organ(SB_TET4, 12, NULL, &mesh, &error)))
        return fail(&error);
    sb_body_def def = sb_default_body_def();
    def.mesh = &mesh;
    def.material = sb_material_corotated(8000, 0.45, 1060); /* E (Pa), Poisson's ratio, density (kg/m^3) */
    def.gravity = sb_v3(0, 0, -9.81);
    if (sb_body_create(&def, &body, &error))
        return fail(&error);
    sb_vec3 low, high;
    sb_mesh_bounds(&mesh, &low, &high);
    for (int i = 0; i < mesh.node_count; i++) /* hold the back third */
        if (mesh.nodes[i].y > high.y - (high.y - low.y) / 3 && sb_body_fix_nodes(body, &i, 1, SB_XYZ))
            return 1;
    sb_step_info info;
    for (int frame = 0; frame < 60; frame++)
        if (sb_body_step(body, 1.0 / 60, &info))
            return fail(&info.error);
    double sag = 0, stress = 0;
    for (int i = 0; i < mesh.node_count; i++)
        sag = sb_max(sag, -sb_body_displacements(body)[i].z);
    sb_mat3 sigma;
    for (int i = 0; i < mesh.element_count; i++)
        if (sb_body_stress(body, i, 0, &sigma) == SB_OK)
            stress = sb_max(stress, sb_von_mises(sigma));
    printf("it sags by %.1f mm, the largest von Mises stress is %.0f Pa\n", 1e3 * sag, stress);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return fflush(stdout) ? perror("hello"), 1 : 0;
}
