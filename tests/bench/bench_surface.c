/* bench_surface: queries on a bumpy ball of about 100,000 triangles. Prints one line per query and kind of points:
 * name, triangles, microseconds per query (median and least of several runs) and a checksum. Points of `box` are
 * uniform in the bounding box, those of `near` within 1 % of its size of the surface, both in random order; `grid` is a
 * lattice of 48 x 48 x 48 points in order, as signed distances are sampled. Asserts nothing. */
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "measure.h"

#include <stdio.h>
#include <stdlib.h>

enum { CELLS = 91, GRID = 48, COUNT = GRID * GRID * GRID, RUNS = 7 };

static double uniform(unsigned long long *state)
{
    *state = *state * 6364136223846793005ULL + 1442695040888963407ULL;
    return (double)(*state >> 11) / 9007199254740992.0;
}

/* A cube of cells blown up to a ball. */
static sb_mesh ball(void)
{
    sb_mesh mesh;
    int side = CELLS + 1, *next;
    memset(&mesh, 0, sizeof mesh);
    mesh.element_type = SB_TRI3;
    mesh.node_count = 6 * side * side;
    mesh.nodes = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)mesh.node_count);
    mesh.element_count = 12 * CELLS * CELLS;
    mesh.elements = next = (int *)malloc(3 * sizeof(int) * (size_t)mesh.element_count);
    for (int v = 0; v < mesh.node_count; v++) {
        int face = v / (side * side), i = v / side % side, j = v % side, axis = face % 3;
        double x[3], radius;
        x[axis] = face < 3 ? 1 : -1;
        x[(axis + 1) % 3] = (face < 3 ? 1 : -1) * (2.0 * i / (int)CELLS - 1);
        x[(axis + 2) % 3] = 2.0 * j / (int)CELLS - 1;
        radius = sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
        radius = (1 + 0.1 * sin(9 * x[0] / radius) * sin(11 * x[1] / radius) * cos(7 * x[2] / radius)) / radius;
        mesh.nodes[v] = sb_v3((sb_real)(radius * x[0]), (sb_real)(radius * x[1]), (sb_real)(radius * x[2]));
        if (i == CELLS || j == CELLS)
            continue;
        *next++ = v, *next++ = v + side, *next++ = v + side + 1;
        *next++ = v, *next++ = v + side + 1, *next++ = v + 1;
    }
    sb_mesh_merge_nodes(&mesh, -1, NULL, NULL);
    return mesh;
}

static void points_of(const char *kind, const sb_mesh *mesh, sb_vec3 *points)
{
    sb_vec3 low, high;
    unsigned long long state = 1;
    sb_mesh_bounds(mesh, &low, &high);
    for (int i = 0; i < COUNT; i++) {
        double u[3];
        sb_vec3 x = low;
        for (int k = 0; k < 3; k++)
            u[k] = uniform(&state);
        if (kind[0] == 'g')
            for (int k = 2, rest = i; k >= 0; k--, rest /= GRID)
                u[k] = (rest % GRID + 0.5) / (int)GRID;
        if (kind[0] == 'n') {
            x = mesh->nodes[(int)(uniform(&state) * mesh->node_count)];
            for (int k = 0; k < 3; k++)
                u[k] = 0.02 * u[k] - 0.01;
        }
        points[i] = sb_v3(x.x + (sb_real)u[0] * (high.x - low.x), x.y + (sb_real)u[1] * (high.y - low.y),
                          x.z + (sb_real)u[2] * (high.z - low.z));
    }
}

/* Query number `which` for all points; *sum: of its answers. */
static const char *ask(int which, const sb_surface *surface, const sb_vec3 *points, sb_real *numbers,
                       sb_surface_hit *hits, double *sum)
{
    static const char *names[] = {"closest", "signed_distance", "winding_number", "ray", "signed_distance_batch"};
#if defined(SB_USE_OPENMP)
    sb_jobs jobs = sb_jobs_openmp(), *use = &jobs;
#else
    sb_jobs *use = NULL;
#endif
    *sum = 0;
    if (which == 4)
        sb_surface_signed_distance_batch(surface, points, COUNT, numbers, hits, use);
    for (int i = 0; i < COUNT; i++) {
        if (which == 0)
            numbers[i] = sb_surface_closest(surface, points[i], SB_REAL_MAX, hits + i) ? hits[i].distance : 0;
        if (which == 1)
            numbers[i] = sb_surface_signed_distance(surface, points[i], hits + i);
        if (which == 2)
            numbers[i] = sb_surface_winding_number(surface, points[i]);
        if (which == 3)
            numbers[i] = sb_surface_ray(surface, points[i], sb_v3(points[i].y, 1, points[i].x), 1, NULL);
        *sum += (double)numbers[i];
    }
    return names[which];
}

static void sort(double *a, int n)
{
    for (int i = 1; i < n; i++)
        for (int k = i; k > 0 && a[k] < a[k - 1]; k--) {
            double swap = a[k];
            a[k] = a[k - 1];
            a[k - 1] = swap;
        }
}

int main(void)
{
    static const char *kinds[] = {"near", "box", "grid"};
    sb_mesh mesh = ball();
    sb_surface *surface = NULL;
    sb_vec3 *points = (sb_vec3 *)malloc(sizeof(sb_vec3) * COUNT);
    sb_real *numbers = (sb_real *)malloc(sizeof(sb_real) * COUNT);
    sb_surface_hit *hits = (sb_surface_hit *)malloc(sizeof(sb_surface_hit) * COUNT);
    double time[RUNS], sum = 0;
    for (int run = 0; run < RUNS; run++) {
        double start = now();
        sb_surface_destroy(surface);
        surface = NULL;
        if (sb_surface_create(&mesh, NULL, &surface, NULL) != SB_OK)
            return 1;
        time[run] = 1e3 * (now() - start);
    }
    sort(time, RUNS);
    printf("surface_create %d triangles  median %.2f ms  min %.2f ms  %.1f MB\n", mesh.element_count, time[RUNS / 2],
           time[0], 1e-6 * (double)sb_surface_bytes(surface));
    for (int run = 0; run < RUNS; run++) {
        double start = now();
        sb_surface_move(surface, mesh.nodes, NULL, NULL);
        time[run] = 1e3 * (now() - start);
    }
    sort(time, RUNS);
    printf("surface_move   %d triangles  median %.2f ms  min %.2f ms\n", mesh.element_count, time[RUNS / 2], time[0]);
    for (int kind = 0; kind < 3; kind++) {
        points_of(kinds[kind], &mesh, points);
        for (int which = 0; which < 5; which++) {
            const char *name = "";
            for (int run = 0; run < RUNS; run++) {
                double start = now();
                name = ask(which, surface, points, numbers, hits, &sum);
                time[run] = 1e6 * (now() - start) / (int)COUNT;
            }
            sort(time, RUNS);
            printf("%-4s %-22s %d triangles  median %.3f us  min %.3f us  sum %.9g\n", kinds[kind], name,
                   mesh.element_count, time[RUNS / 2], time[0], sum);
        }
    }
    sb_surface_destroy(surface);
    sb_mesh_free(&mesh);
    free(points);
    free(numbers);
    free(hits);
    return 0;
}
