/* Writes the files that the documentation's programs load. */
#include "softbody.h"

#include <stdio.h>

int main(void)
{
    sb_mesh mesh;
    sb_boundary skin;
    sb_error error;
    if (sb_mesh_organ(SB_TET4, 10, NULL, &mesh, &error) != SB_OK ||
        sb_mesh_save_vtk("liver.vtk", &mesh, NULL, 0, &error) != SB_OK ||
        sb_mesh_boundary(&mesh, 1, NULL, &skin, &error) != SB_OK ||
        sb_mesh_save_obj("liver.obj", &skin.surface, &error) != SB_OK) {
        printf("%s\n", error.message);
        return 1;
    }
    sb_boundary_free(&skin);
    sb_mesh_free(&mesh);
    return 0;
}
