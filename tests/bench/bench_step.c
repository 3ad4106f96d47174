/* bench_step: whole steps of the workloads that any program can run the same.
 *
 *     beam_tet4_13k    cantilever 0.2 x 0.06 x 0.06 m, about 13,400 tet4, corotated, E 50 kPa, nu 0.45, rho 1000,
 *     beam_tet4_100k   Rayleigh beta 0.02 s, gravity, dt 10 ms, implicit Euler; about 100,000 tet4;
 *     beam_tet10_9k    9,216 tet10
 *     beam_tet10_9k_49 the same with nu 0.49
 *     liver_tet10_3k   the liver of the shared data (else a generated organ), about 3,000 tet10, a tool pushing at
 *                      1 cm/s
 *     demo_liver_10k   the demo's scene: the liver with 9,777 tet4 (else a generated organ), dt 1/60 s, residual 1e-2
 *     liver_10k_4999   the same with nu 0.4999, of tet4 that lock
 *     liver_10k_patch  and of tet4 with patches, which do not
 *
 * One line per workload and tolerance:
 *     name tol n_dof median_ms min_ms p99_ms iterations bytes checksum | force tangent precond solve (ms)
 * The times are over 100 steps after 10 to warm up (fewer where they take long), iterations their mean, bytes what the
 * body holds, the checksum the sum of |u| after ten steps from rest solved to 1e-10. Asserts nothing. */
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "measure.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static size_t bytes_given;

typedef struct workload {
    const char *name;
    int tool; /* node that pushes, or -1 */
    sb_mesh mesh;
    sb_real dt;
    sb_real young, poisson, density;
    sb_integration integration;
} workload;

static sb_body *make_body(const workload *w, double tolerance)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_error error;
    sb_vec3 low, high;
    bytes_given = 0;
    def.mesh = &w->mesh;
    def.material = sb_material_corotated(w->young, w->poisson, w->density);
    def.integration = w->integration;
    def.gravity = sb_v3(0, 0, (sb_real)-9.81);
    def.damping_stiffness = (sb_real)0.02;
    def.tolerance = (sb_real)tolerance;
    def.max_iterations = 5000;
    def.allocator = counting_allocator(&bytes_given);
    def.clock = now;
    def.jobs = jobs_asked_for();
    if (sb_body_create(&def, &body, &error) != SB_OK) {
        printf("%s: %s\n", w->name, error.message);
        return NULL;
    }
    sb_mesh_bounds(&w->mesh, &low, &high);
    for (int i = 0; i < w->mesh.node_count; i++) /* beams at x = 0, organs at their top */
        if (w->tool < 0 ? w->mesh.nodes[i].x < (sb_real)1e-6
                        : w->mesh.nodes[i].z > high.z - (sb_real)0.15 * (high.z - low.z))
            sb_body_fix_nodes(body, &i, 1, SB_XYZ);
    return body;
}

static sb_result step(const workload *w, sb_body *body, int number, sb_step_info *info)
{
    if (w->tool >= 0) { /* 1 cm/s upwards */
        sb_vec3 target = sb_v3(0, 0, (sb_real)0.01 * w->dt * (sb_real)number);
        sb_body_prescribe(body, &w->tool, 1, SB_XYZ, &target, 1);
    }
    return sb_body_step(body, w->dt, info);
}

/* Sum of |u| after ten steps from rest, solved to 1e-10: a fast wrong answer shows. */
static double checksum(const workload *w)
{
    double sum = 0;
    sb_step_info info;
    sb_body *body = make_body(w, 1e-10);
    for (int k = 0; body && k < 10; k++)
        step(w, body, k, &info);
    for (int i = 0; body && i < w->mesh.node_count; i++)
        sum += (double)sb_v3_norm(sb_body_displacements(body)[i]);
    sb_body_destroy(body);
    return sum;
}

static void run(const workload *w, double tolerance, double sum)
{
    enum { WARM = 10, MOST = 100 };
    double times[MOST], phases[4] = {0, 0, 0, 0}, started, total = 0;
    int count = 0, iterations = 0;
    size_t bytes;
    sb_body *body = make_body(w, tolerance);
    if (!body)
        return;
    bytes = bytes_given;
    for (int k = 0; k < WARM + MOST && (k < WARM + 20 || total < 20); k++) {
        sb_step_info info;
        started = now();
        if (step(w, body, k, &info) != SB_OK) {
            printf("%s: %s\n", w->name, info.error.message);
            break;
        }
        if (k < WARM)
            continue;
        times[count] = now() - started;
        total += times[count++];
        iterations += info.pcg_iterations;
        phases[0] += info.seconds_force;
        phases[1] += info.seconds_tangent;
        phases[2] += info.seconds_precond;
        phases[3] += info.seconds_solve;
    }
    if (count == 0)
        return;
    qsort(times, (size_t)count, sizeof times[0], ascending);
    printf("%-15s %.0e %7d %8.2f %8.2f %8.2f %6.1f %10lu ", w->name, tolerance, 3 * w->mesh.node_count,
           1e3 * times[count / 2], 1e3 * times[0], 1e3 * times[count * 99 / 100], (double)iterations / count,
           (unsigned long)bytes);
    printf("%.9e | %.2f %.2f %.2f %.2f\n", sum, 1e3 * phases[0] / count, 1e3 * phases[1] / count,
           1e3 * phases[2] / count, 1e3 * phases[3] / count);
    fflush(stdout);
    sb_body_destroy(body);
}

static void run_both(const workload *w)
{
    double sum = checksum(w);
    run(w, 1e-2, sum);
    run(w, 1e-5, sum);
}

static void run_beam(const char *name, sb_element_type type, int nx, int ny, int nz, double poisson)
{
    workload w;
    memset(&w, 0, sizeof w);
    w.name = name;
    w.tool = -1;
    w.dt = (sb_real)0.01;
    w.young = 50000;
    w.poisson = (sb_real)poisson;
    w.density = 1000;
    if (sb_mesh_beam(type, nx, ny, nz, sb_v3((sb_real)0.2, (sb_real)0.06, (sb_real)0.06), NULL, &w.mesh, NULL) != SB_OK)
        return;
    sb_mesh_reorder(&w.mesh, NULL, NULL, NULL);
    run_both(&w);
    sb_mesh_free(&w.mesh);
}

/* The organ of the shared data, or a generated one of about the same size. */
static void run_organ(const char *name, const char *file, sb_element_type type, int cells, double dt, double poisson,
                      sb_integration integration)
{
    workload w;
    const char *shared = getenv("SHARED");
    char path[1024];
    memset(&w, 0, sizeof w);
    snprintf(path, sizeof path, "%s/data/volumes/%s", shared ? shared : "../shared", file);
    if (sb_mesh_load(&w.mesh, path, NULL, NULL) != SB_OK && sb_mesh_organ(type, cells, NULL, &w.mesh, NULL) != SB_OK)
        return;
    sb_mesh_reorder(&w.mesh, NULL, NULL, NULL);
    w.name = name;
    w.dt = (sb_real)dt;
    w.young = 5000;
    w.poisson = (sb_real)poisson;
    w.density = 1060;
    w.integration = integration;
    for (int i = 0; i < w.mesh.node_count; i++)
        if (w.mesh.nodes[i].z < w.mesh.nodes[w.tool].z)
            w.tool = i;
    run_both(&w);
    sb_mesh_free(&w.mesh);
}

int main(void)
{
    printf("# name tol n_dof median_ms min_ms p99_ms iterations bytes checksum | force tangent precond solve\n");
    run_beam("beam_tet4_13k", SB_TET4, 28, 9, 9, 0.45);
    run_beam("beam_tet4_100k", SB_TET4, 57, 17, 17, 0.45);
    run_beam("beam_tet10_9k", SB_TET10, 24, 8, 8, 0.45);
    run_beam("beam_tet10_9k_49", SB_TET10, 24, 8, 8, 0.49);
    run_organ("liver_tet10_3k", "liver_a_tet10_3k.vtk", SB_TET10, 9, 0.01, 0.45, SB_INTEGRATION_AUTO);
    run_organ("demo_liver_10k", "liver_a_tet4_10k.vtk", SB_TET4, 15, 1.0 / 60, 0.45, SB_INTEGRATION_AUTO);
    run_organ("liver_10k_4999", "liver_a_tet4_10k.vtk", SB_TET4, 15, 1.0 / 60, 0.4999, SB_INTEGRATION_AUTO);
    run_organ("liver_10k_patch", "liver_a_tet4_10k.vtk", SB_TET4, 15, 1.0 / 60, 0.4999, SB_INTEGRATION_PATCH);
    return 0;
}
