/* Writes the files that the documentation's programs load. */
#include "softbody.h"

#include <stdio.h>

int main(void)
{
    sb_mesh mesh;
    sb_error error;
    if (sb_mesh_organ(SB_TET4, 10, NULL, &mesh, &error) != SB_OK ||
        sb_mesh_save_vtk("liver.vtk", &mesh, NULL, 0, &error) != SB_OK) {
        printf("%s\n", error.message);
        return 1;
    }
    sb_mesh_free(&mesh);
    return 0;
}
