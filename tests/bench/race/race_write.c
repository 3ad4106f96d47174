/* race_write: writes the systems that the racers solve (see race.h) into a folder: those of the workloads in
 * bench_step.c, and beams that make a series of growing size with beam_tet10_9k. Argument: the folder. */
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "../elastic.h"

#include <stdio.h>
#include <stdlib.h>

static void put(FILE *file, const void *data, size_t count, size_t size)
{
    if (fwrite(data, size, count, file) != count) {
        fprintf(stderr, "race_write: the file cannot be written\n");
        exit(1);
    }
}

static void save(const char *folder, const char *name, double poisson, const sb_mesh *mesh, const sb_matrix *a,
                 const sb_real *rhs)
{
    int corners = mesh->element_type == SB_TET10 ? 10 : 4;
    int sizes[4] = {a->row_count, a->block_count, mesh->element_count, corners};
    char path[1024];
    FILE *file;
    snprintf(path, sizeof path, "%s/%s.system", folder, name);
    file = fopen(path, "wb");
    if (!file) {
        fprintf(stderr, "race_write: %s cannot be opened\n", path);
        exit(1);
    }
    put(file, "SBRACE02", 8, 1);
    put(file, sizes, 4, sizeof(int));
    put(file, &poisson, 1, sizeof poisson);
    put(file, a->row_start, (size_t)a->row_count + 1, sizeof(int));
    put(file, a->columns, (size_t)a->block_count, sizeof(int));
    put(file, a->blocks, 9 * (size_t)a->block_count, sizeof(double));
    put(file, mesh->nodes, 3 * (size_t)a->row_count, sizeof(double));
    put(file, rhs, 3 * (size_t)a->row_count, sizeof(double));
    put(file, mesh->elements, (size_t)mesh->element_count * (size_t)corners, sizeof(int));
    put(file, a->fixed, (size_t)a->row_count, 1);
    if (fclose(file) != 0)
        exit(1);
}

static void write_beam(const char *folder, const char *name, sb_element_type type, const int *n, double poisson)
{
    const elastic_system system = {50e3, poisson, NULL, 0};
    sb_mesh mesh;
    sb_matrix a;
    unsigned char *mask;
    sb_real *rhs;
    int corners = type == SB_TET10 ? 10 : 4;
    if (sb_mesh_beam(type, n[0], n[1], n[2], sb_v3(0.2, 0.06, 0.06), NULL, &mesh, NULL) != SB_OK ||
        sb_mesh_reorder(&mesh, NULL, NULL, NULL) != SB_OK ||
        sb_matrix_create(mesh.node_count, mesh.element_count, corners, NULL, mesh.elements, NULL, &a, NULL) != SB_OK)
        exit(1);
    mask = (unsigned char *)calloc((size_t)mesh.node_count, 1);
    rhs = (sb_real *)calloc(3 * (size_t)mesh.node_count, sizeof(sb_real));
    if (!mask || !rhs)
        exit(1);
    for (int i = 0; i < mesh.node_count; i++)
        mask[i] = mesh.nodes[i].x < 1e-6 ? SB_XYZ : 0;
    elastic_assemble(mesh.nodes, mesh.elements, mesh.element_count, corners, &system, &a, rhs);
    sb_matrix_constrain(&a, mask, NULL, rhs);
    save(folder, name, poisson, &mesh, &a, rhs);
    printf("# %s: %d unknowns, %d blocks\n", name, 3 * mesh.node_count, a.block_count);
    free(mask);
    free(rhs);
    sb_matrix_free(&a);
    sb_mesh_free(&mesh);
}

int main(int argc, char **argv)
{
    static const struct {
        const char *name;
        sb_element_type type;
        int n[3];
        double poisson;
    } beams[] = {{"beam_tet4_13k", SB_TET4, {28, 9, 9}, 0.45},  {"beam_tet4_100k", SB_TET4, {57, 17, 17}, 0.45},
                 {"beam_tet10_9k", SB_TET10, {25, 8, 8}, 0.45}, {"beam_tet10_9k_49", SB_TET10, {25, 8, 8}, 0.49},
                 {"series_5k", SB_TET10, {11, 4, 4}, 0.45},     {"series_13k", SB_TET10, {17, 5, 5}, 0.45},
                 {"series_137k", SB_TET10, {36, 12, 12}, 0.45}, {"series_310k", SB_TET10, {47, 16, 16}, 0.45}};
    if (argc != 2) {
        fprintf(stderr, "race_write FOLDER\n");
        return 1;
    }
    for (int k = 0; k < (int)(sizeof beams / sizeof *beams); k++)
        write_beam(argv[1], beams[k].name, beams[k].type, beams[k].n, beams[k].poisson);
    return 0;
}
