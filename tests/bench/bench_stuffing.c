/* bench_stuffing: tets from a liver's surface (workload stuff_liver). Prints one line per case: name, tets, nodes, tree
 * of the surface in ms (median), stuffing in ms (median and least of 21 runs), smallest and largest dihedral angle,
 * distance to the surface in cells, checksum (volume in cm^3). The surface is ../shared/data/surfaces/liver_a.obj, or a
 * file given as argument. Asserts nothing. */
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "measure.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { RUNS = 21 };

static int run(const char *name, const sb_mesh *input, double cells, int levels)
{
    double tree[RUNS], stuff[RUNS];
    sb_stuff_report report;
    sb_real cell = 0;
    for (int i = 0; i < RUNS; i++) {
        sb_surface *surface = NULL;
        sb_shape shape;
        sb_stuff_def def = sb_default_stuff_def();
        sb_mesh mesh;
        sb_error error;
        sb_vec3 low, high;
        double start = now();
        memset(&mesh, 0, sizeof mesh);
        memset(&shape, 0, sizeof shape);
        if (sb_surface_create(input, NULL, &surface, &error) != SB_OK)
            return fprintf(stderr, "%s\n", error.message);
        tree[i] = now() - start;
        sb_surface_bounds(surface, &low, &high);
        shape.surface = surface;
        def.shapes = &shape;
        def.shape_count = 1;
        def.cell = cell = sb_max(high.x - low.x, sb_max(high.y - low.y, high.z - low.z)) / (sb_real)cells;
        def.levels = levels;
#if defined(SB_USE_OPENMP)
        def.jobs = sb_jobs_openmp();
#endif
        start = now();
        if (sb_mesh_stuff(&def, &mesh, &report, &error) != SB_OK)
            return fprintf(stderr, "%s\n", error.message);
        stuff[i] = now() - start;
        sb_mesh_free(&mesh);
        sb_surface_destroy(surface);
    }
    qsort(tree, RUNS, sizeof tree[0], ascending);
    qsort(stuff, RUNS, sizeof stuff[0], ascending);
    printf("%-20s %8d tets %8d nodes  tree %6.2f ms  stuffing %8.2f ms (least %8.2f)  %6.2f %6.2f degrees  %.3f cells  "
           "%.6f\n",
           name, report.element_count, report.node_count, 1e3 * tree[RUNS / 2], 1e3 * stuff[RUNS / 2], 1e3 * stuff[0],
           (double)report.min_dihedral, (double)report.max_dihedral, (double)(report.distance / cell),
           1e6 * (double)report.volume);
    return 0;
}

int main(int argc, char **argv)
{
    const char *path = argc > 1 ? argv[1] : "../shared/data/surfaces/liver_a.obj";
    sb_mesh input;
    sb_error error;
    int failed;
    memset(&input, 0, sizeof input);
    if (sb_mesh_load(&input, path, NULL, &error) != SB_OK) {
        printf("stuff_liver: skipped: %s\n", error.message);
        return 0;
    }
    failed = run("stuff_liver", &input, 29.5, 0) || run("stuff_liver_graded", &input, 31.5, 3) ||
             run("stuff_liver_120k", &input, 40, 0);
    sb_mesh_free(&input);
    return failed != 0;
}
