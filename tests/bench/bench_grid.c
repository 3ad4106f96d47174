/* bench_grid: weighted cells against plain hexahedra (workload wc_liver).
 *
 *     wc_liver_N   the liver of the shared data (else a generated organ) in a grid of 30 cells along its longest side,
 *                  weighted cells of level N
 *     hex8_plain   a block of whole hexahedra, about as many of them
 *
 * One line per grid:
 *     name n_dof cells points build_ms tangent_ms min_ms bytes checksum
 * build_ms: making the grid; tangent_ms: assembly of a neo-Hookean tangent in an iteration of Newton's method, median
 * over steps, and their minimum; bytes: what the body holds; the checksum is the volume (m^3). Asserts nothing. */
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "measure.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static size_t bytes_given;

/* Steps a body that is held at its top and prints its line. */
static void run(const char *name, const sb_mesh *mesh, const sb_domain *domain, double build, double sum)
{
    enum { WARM = 2, STEPS = 15 };
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_error error;
    sb_vec3 low, high;
    double times[STEPS];
    int points;
    bytes_given = 0;
    def.mesh = mesh;
    def.domain = domain;
    def.material = sb_material_neo_hookean(5e3, 0.45, 1060);
    def.gravity = sb_v3(0, 0, (sb_real)-9.81);
    def.damping_stiffness = (sb_real)0.02;
    def.tolerance = (sb_real)1e-2;
    def.max_newton = 1;
    def.allocator = counting_allocator(&bytes_given);
    def.jobs = jobs_asked_for();
    def.clock = now;
    if (sb_body_create(&def, &body, &error) != SB_OK) {
        printf("%s: %s\n", name, error.message);
        return;
    }
    points = sb_body_point_count(body) * sb_body_element_count(body);
    sb_mesh_bounds(mesh, &low, &high);
    for (int i = 0; i < mesh->node_count; i++)
        if (mesh->nodes[i].z > high.z - (sb_real)0.15 * (high.z - low.z))
            sb_body_fix_nodes(body, &i, 1, SB_XYZ);
    for (int k = 0; k < WARM + STEPS; k++) {
        sb_step_info info;
        if (sb_body_step(body, (sb_real)0.01, &info) != SB_OK) {
            printf("%s: %s\n", name, info.error.message);
            sb_body_destroy(body);
            return;
        }
        if (k >= WARM)
            times[k - WARM] = info.seconds_tangent;
    }
    qsort(times, STEPS, sizeof times[0], ascending);
    printf("%-14s %7d %7d %8d %9.1f %8.2f %8.2f %10lu %.9e\n", name, 3 * mesh->node_count, mesh->element_count, points,
           1e3 * build, 1e3 * times[STEPS / 2], 1e3 * times[0], (unsigned long)bytes_given, sum);
    fflush(stdout);
    sb_body_destroy(body);
}

static sb_surface *load_liver(sb_vec3 *low, sb_vec3 *high)
{
    const char *root = getenv("SHARED");
    char path[512];
    sb_mesh mesh;
    sb_surface *surface = NULL;
    memset(&mesh, 0, sizeof mesh);
    snprintf(path, sizeof path, "%s/data/surfaces/liver_a.obj", root ? root : "../shared");
    if (sb_mesh_load(&mesh, path, NULL, NULL) != SB_OK) {
        sb_mesh organ;
        sb_boundary boundary;
        if (sb_mesh_organ(SB_TET4, 30, NULL, &organ, NULL) != SB_OK)
            return NULL;
        if (sb_mesh_boundary(&organ, 1, NULL, &boundary, NULL) == SB_OK) {
            sb_mesh_copy(&boundary.surface, NULL, &mesh, NULL);
            sb_boundary_free(&boundary);
        }
        sb_mesh_free(&organ);
    }
    if (sb_surface_create(&mesh, NULL, &surface, NULL) == SB_OK)
        sb_surface_bounds(surface, low, high);
    sb_mesh_free(&mesh);
    return surface;
}

int main(void)
{
    sb_vec3 low, high;
    sb_surface *liver = load_liver(&low, &high);
    int cells = 0;
    if (!liver) {
        printf("bench_grid: no liver\n");
        return 1;
    }
    printf("# name n_dof cells points build_ms tangent_ms min_ms bytes checksum (%d triangles)\n",
           sb_surface_triangle_count(liver));
    for (int level = 0; level <= 4; level++) {
        sb_grid_def def = sb_default_grid_def();
        sb_grid grid;
        sb_error error;
        char name[32];
        double started = now();
        def.outer.surface = liver;
        def.cells = 30;
        def.level = level;
        def.jobs = jobs_asked_for();
        memset(&grid, 0, sizeof grid);
        if (sb_grid_create(&def, &grid, &error) != SB_OK) {
            printf("bench_grid: %s\n", error.message);
            continue;
        }
        snprintf(name, sizeof name, "wc_liver_%d", level);
        started = now() - started;
        run(name, &grid.body_mesh, &grid.domain, started, (double)grid.volume);
        cells = grid.body_mesh.element_count;
        sb_grid_free(&grid);
    }
    if (cells > 0) {
        sb_mesh block;
        int n = 1;
        while (2 * n * n * n < cells)
            n++;
        memset(&block, 0, sizeof block);
        double started = now();
        if (sb_mesh_beam(SB_HEX8, 2 * n, n, n, sb_v3((sb_real)0.2, (sb_real)0.1, (sb_real)0.1), NULL, &block, NULL) ==
            SB_OK)
            run("hex8_plain", &block, NULL, now() - started, (double)sb_mesh_volume(&block));
        sb_mesh_free(&block);
    }
    sb_surface_destroy(liver);
    return 0;
}
