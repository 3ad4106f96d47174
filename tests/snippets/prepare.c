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

/* A block of 10 mm in two regions with names, as gmsh writes it, the triangle below as a third. */
static sb_result save_foreign(sb_error *error)
{
    static const char two[] = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$PhysicalNames\n3\n2 3 \"bed\"\n3 1 \"liver\"\n"
                              "3 2 \"tumour\"\n$EndPhysicalNames\n$Nodes\n5\n1 0 0 0\n2 0.01 0 0\n3 0 0.01 0\n"
                              "4 0 0 0.01\n5 0.01 0.01 0.01\n$EndNodes\n$Elements\n3\n1 2 2 3 1 1 2 3\n"
                              "2 4 2 1 1 1 2 3 4\n3 4 2 2 2 2 3 4 5\n$EndElements\n";
    return sb_file_save("two.msh", two, sizeof two - 1, error);
}

int main(void)
{
    sb_mesh mesh;
    sb_boundary skin;
    sb_error error;
    if (sb_mesh_organ(SB_TET4, 10, NULL, &mesh, &error) != SB_OK ||
        sb_mesh_save_vtk("liver.vtk", &mesh, NULL, 0, &error) != SB_OK || save_scan(&error) != SB_OK ||
        save_foreign(&error) != SB_OK || sb_mesh_boundary(&mesh, 1, NULL, &skin, &error) != SB_OK ||
        sb_mesh_save_obj("liver.obj", &skin.surface, &error) != SB_OK) {
        printf("%s\n", error.message);
        return 1;
    }
    sb_boundary_free(&skin);
    sb_mesh_free(&mesh);
    return 0;
}
