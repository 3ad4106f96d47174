/* bench_embed: the workload embed_100k: about 100,000 vertices of a liver's surface on about 3,000 tet10, built once
 * and evaluated per frame; and the same surface on tet4 and on a generated organ of hex8.
 *
 * The liver is that of the shared data (folder SHARED, else ../shared), or a generated organ. One line per mesh:
 *     name points elements inside offset frame | build points points+normals carried forces (median/min ms) | checksum
 * The build is the fastest of 5; the times of frames are medians and smallest over 200. `carried` is with rest normals
 * instead of the surface's. The checksum is the sum of all coordinates of points and normals. Asserts nothing. */
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "measure.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { FRAMES = 200 };

static int load(sb_mesh *mesh, const char *name)
{
    const char *shared = getenv("SHARED");
    char path[1024];
    memset(mesh, 0, sizeof *mesh);
    snprintf(path, sizeof path, "%s/data/%s", shared ? shared : "../shared", name);
    return sb_mesh_load(mesh, path, NULL, NULL) == SB_OK;
}

/* Cuts every triangle into parts * parts. */
static int refine(const sb_mesh *coarse, int parts, sb_mesh *fine)
{
    int per = (parts + 1) * (parts + 2) / 2;
    memset(fine, 0, sizeof *fine);
    fine->element_type = SB_TRI3;
    fine->node_count = per * coarse->element_count;
    fine->nodes = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)fine->node_count);
    fine->elements = (int *)malloc(sizeof(int) * 3 * (size_t)(parts * parts) * (size_t)coarse->element_count);
    for (int t = 0; t < coarse->element_count; t++) {
        const int *corner = coarse->elements + 3 * t;
        int first = t * per, row = 0;
        for (int j = 0; j <= parts; j++)
            for (int i = 0; i <= parts - j; i++) {
                sb_real r = (sb_real)i / (sb_real)parts, s = (sb_real)j / (sb_real)parts;
                sb_vec3 x = sb_v3_scale(1 - r - s, coarse->nodes[corner[0]]);
                x = sb_v3_madd(x, r, coarse->nodes[corner[1]]);
                fine->nodes[first + row + i] = sb_v3_madd(x, s, coarse->nodes[corner[2]]);
                if (i < parts - j) {
                    int *e = fine->elements + 3 * fine->element_count++;
                    e[0] = first + row + i, e[1] = e[0] + 1, e[2] = e[0] + parts - j + 1;
                }
                if (i < parts - j - 1) {
                    int *e = fine->elements + 3 * fine->element_count++;
                    e[0] = first + row + i + 1, e[1] = e[0] + parts - j + 1, e[2] = e[1] - 1;
                }
                if (i == parts - j)
                    row += parts - j + 1;
            }
    }
    return sb_mesh_merge_nodes(fine, -1, NULL, NULL) == SB_OK;
}

/* A bend and a twist of the rest positions, so that no frame is like the one before. */
static void deform(const sb_mesh *mesh, int frame, sb_vec3 *x)
{
    sb_real turn = (sb_real)0.02 * (sb_real)(frame % 50);
    for (int i = 0; i < mesh->node_count; i++) {
        sb_vec3 p = mesh->nodes[i];
        x[i] = sb_v3(p.x + turn * p.y * p.z * 10, p.y + turn * p.z, p.z + turn * p.x * p.x * 10);
    }
}

/* In milliseconds. */
typedef struct timing {
    double median, least;
} timing;

static timing time_updates(sb_embedding *embedding, const sb_mesh *mesh, sb_vec3 *x, sb_vec3 *points, sb_vec3 *normals,
                           sb_vec3 *forces)
{
    double times[FRAMES];
    timing result;
    sb_jobs threads = jobs_asked_for();
    for (int f = 0; f < FRAMES; f++) {
        double start;
        deform(mesh, f, x);
        start = now();
        if (forces)
            sb_embedding_forces(embedding, x, points, forces, &threads);
        else
            sb_embedding_update(embedding, x, points, normals, &threads);
        times[f] = now() - start;
    }
    qsort(times, FRAMES, sizeof times[0], ascending);
    result.median = 1e3 * times[FRAMES / 2];
    result.least = 1e3 * times[0];
    return result;
}

static void run(const char *name, const sb_mesh *mesh, const sb_mesh *surface)
{
    sb_embedding_def def = sb_default_embedding_def();
    sb_embedding *embedding = NULL, *carried = NULL;
    sb_embedding_report report;
    sb_error error;
    double build = 1e300, sum = 0;
    timing result[4];
    sb_vec3 *x = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)mesh->node_count);
    sb_vec3 *forces = (sb_vec3 *)calloc((size_t)mesh->node_count, sizeof(sb_vec3));
    sb_vec3 *points = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)surface->node_count);
    sb_vec3 *normals = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)surface->node_count);
    def.mesh = mesh;
    def.surface = surface;
    def.jobs = jobs_asked_for();
    for (int k = 0; k < 5; k++) {
        double start = now();
        sb_embedding_destroy(embedding);
        if (sb_embedding_create(&def, &embedding, &error) != SB_OK) {
            printf("%s: %s\n", name, error.message);
            return;
        }
        build = now() - start < build ? now() - start : build;
    }
    report = sb_embedding_get_report(embedding);
    result[0] = time_updates(embedding, mesh, x, points, NULL, NULL);
    result[1] = time_updates(embedding, mesh, x, points, normals, NULL);
    for (int i = 0; i < surface->node_count; i++)
        sum += (double)(points[i].x + points[i].y + points[i].z + normals[i].x + normals[i].y + normals[i].z);
    result[3] = time_updates(embedding, mesh, x, points, NULL, forces);
    sb_embedding_update(embedding, mesh->nodes, points, normals, NULL);
    def.normals = normals;
    sb_embedding_create(&def, &carried, &error);
    result[2] = time_updates(carried, mesh, x, points, normals, NULL);
    printf("%-12s %7d %6d %7d %7d %5d | %8.1f", name, report.point_count, mesh->element_count, report.inside,
           report.offset, report.frame, 1e3 * build);
    for (int k = 0; k < 4; k++)
        printf(" %6.2f/%.2f", result[k].median, result[k].least);
    printf(" | %.9e\n", sum);
    fflush(stdout);
    sb_embedding_destroy(embedding);
    sb_embedding_destroy(carried);
    free(x);
    free(forces);
    free(points);
    free(normals);
}

int main(void)
{
    sb_mesh volume, coarse, surface;
    sb_boundary boundary;
    printf("# name points elements inside offset frame | build points points+normals carried forces | checksum\n");
    if (!load(&coarse, "surfaces/liver_a.vtk")) {
        if (sb_mesh_organ(SB_TET4, 24, NULL, &volume, NULL) != SB_OK ||
            sb_mesh_boundary(&volume, 1, NULL, &boundary, NULL) != SB_OK)
            return 1;
        coarse = boundary.surface;
        sb_mesh_free(&volume);
    }
    if (!refine(&coarse, coarse.element_count > 0 ? (int)(0.5 + sb_sqrt(2.0e5 / coarse.element_count)) : 1, &surface))
        return 1;
    if (load(&volume, "volumes/liver_a_tet10_3k.vtk") || sb_mesh_organ(SB_TET10, 10, NULL, &volume, NULL) == SB_OK)
        run("embed_100k", &volume, &surface);
    sb_mesh_free(&volume);
    if (load(&volume, "volumes/liver_a_tet4_10k.vtk") || sb_mesh_organ(SB_TET4, 16, NULL, &volume, NULL) == SB_OK)
        run("tet4_10k", &volume, &surface);
    sb_mesh_free(&volume);
    if (sb_mesh_organ(SB_HEX8, 16, NULL, &volume, NULL) == SB_OK)
        run("hex8_organ", &volume, &surface);
    sb_mesh_free(&volume);
    return 0;
}
