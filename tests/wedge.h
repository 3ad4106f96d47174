/* wedge.h: a custom element for tests that the library does not have. */
#ifndef WEDGE_H
#define WEDGE_H

#include "scene.h"

/* ---- the wedge: triangle (r, s) times t in [-1, 1], VTK's order ---- */

static inline void wedge_shape(const void *user, const sb_real xi[3], sb_real *shape, sb_real (*gradient)[3])
{
    (void)user;
    for (int a = 0; a < 6; a++) {
        sb_real up = REAL(a < 3 ? -0.5 : 0.5), height = REAL(0.5) + up * xi[2];
        sb_real flat = a % 3 == 0 ? 1 - xi[0] - xi[1] : xi[a % 3 - 1];
        if (shape)
            shape[a] = flat * height;
        if (gradient) {
            gradient[a][0] = height * REAL(a % 3 == 0 ? -1 : a % 3 == 1);
            gradient[a][1] = height * REAL(a % 3 == 0 ? -1 : a % 3 == 2);
            gradient[a][2] = flat * up;
        }
    }
}

static const sb_real wedge_nodes[6][3] = {{0, 0, -1}, {1, 0, -1}, {0, 1, -1}, {0, 0, 1}, {1, 0, 1}, {0, 1, 1}};
static const sb_element_table_face wedge_faces[5] = {{SB_TRI3, {0, 2, 1}},
                                                     {SB_TRI3, {3, 4, 5}},
                                                     {SB_QUAD4, {0, 1, 4, 3}},
                                                     {SB_QUAD4, {1, 2, 5, 4}},
                                                     {SB_QUAD4, {2, 0, 3, 5}}};
#define WEDGE_A REAL(1.0 / 6)
#define WEDGE_B REAL(2.0 / 3)
#define WEDGE_T REAL(0.57735026918962576451)
static const sb_real wedge_points[6][3] = {{WEDGE_A, WEDGE_A, -WEDGE_T}, {WEDGE_B, WEDGE_A, -WEDGE_T},
                                           {WEDGE_A, WEDGE_B, -WEDGE_T}, {WEDGE_A, WEDGE_A, WEDGE_T},
                                           {WEDGE_B, WEDGE_A, WEDGE_T},  {WEDGE_A, WEDGE_B, WEDGE_T}};
static const sb_real wedge_weights[6] = {WEDGE_A, WEDGE_A, WEDGE_A, WEDGE_A, WEDGE_A, WEDGE_A};

static inline sb_element_table wedge_table(void)
{
    sb_element_table table;
    memset(&table, 0, sizeof table);
    table.name = "wedge";
    table.node_count = table.corner_count = 6;
    table.node_points = wedge_nodes;
    table.shape = wedge_shape;
    table.point_count = table.mass_point_count = 6;
    table.points = table.mass_points = wedge_points;
    table.weights = table.mass_weights = wedge_weights;
    table.face_count = 5;
    table.faces = wedge_faces;
    table.vtk_type = 13;
    return table;
}

/* The box of scene_box with every hexahedron cut into two wedges. */
static inline sb_mesh wedge_box(const sb_element_table *table, int nx, int ny, int nz, sb_vec3 size, double shake)
{
    static const int halves[2][6] = {{0, 1, 3, 4, 5, 7}, {1, 2, 3, 5, 6, 7}};
    sb_mesh mesh = scene_box(SB_HEX8, nx, ny, nz, size, shake);
    int *wedges = (int *)malloc(sizeof(int) * 12 * (size_t)mesh.element_count);
    for (int e = 0; e < mesh.element_count; e++)
        for (int k = 0; k < 12; k++)
            wedges[12 * e + k] = mesh.elements[8 * e + halves[k / 6][k % 6]];
    free(mesh.elements);
    mesh.elements = wedges;
    mesh.element_count *= 2;
    mesh.element_type = SB_CUSTOM;
    mesh.table = table;
    return mesh;
}

#endif /* WEDGE_H */
