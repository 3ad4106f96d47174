/* Writes the files that the documentation's programs load. */
#include "softbody.h"

#include <stdio.h>

/* A liver of 100 mm with a tumour in it, as labels of 512 voxels. */
static sb_result save_scan(sb_error *error)
{
    char text[2048];
    int length = snprintf(text, sizeof text,
                          "NRRD0004\ntype: uchar\ndimension: 3\nsizes: 8 8 8\nspacings: 12 12 12\n"
                          "encoding: ascii\n\n");
    for (int n = 0; n < 512; n++) {
        int i = n % 8, j = n / 8 % 8, k = n / 64, rim = !i || !j || !k || i == 7 || j == 7 || k == 7;
        int tumour = i > 3 && i < 6 && j > 3 && j < 6 && k > 3 && k < 6;
        length += snprintf(text + length, sizeof text - (size_t)length, "%d ", rim ? 0 : tumour ? 2 : 1);
    }
    return sb_file_save("scan.nrrd", text, (size_t)length, error);
}

int main(void)
{
    sb_mesh mesh;
    sb_boundary skin;
    sb_error error;
    if (sb_mesh_organ(SB_TET4, 10, NULL, &mesh, &error) != SB_OK ||
        sb_mesh_save_vtk("liver.vtk", &mesh, NULL, 0, &error) != SB_OK || save_scan(&error) != SB_OK ||
        sb_mesh_boundary(&mesh, 1, NULL, &skin, &error) != SB_OK ||
        sb_mesh_save_obj("liver.obj", &skin.surface, &error) != SB_OK) {
        printf("%s\n", error.message);
        return 1;
    }
    sb_boundary_free(&skin);
    sb_mesh_free(&mesh);
    return 0;
}
