/* bench_tissue: steps of the tissue of needle.h, alone and with a needle that remeshes it.
 *
 *     tissue_13k        block 85 x 55 x 60 mm of 13,464 tet4, bottom fixed, E 80 kPa, nu 0.45, rho 1000, Rayleigh beta
 *                       5 ms, gravity, forces that swing along an inner line of nodes, dt 20 ms, Newmark, residual 1e-3
 *     tissue_13k_turned the same with the stiffness of every tet turned at every step
 *     tissue_13k_needle the same as the first with a needle that goes in and out by 0.3 mm per step
 *
 * One line per workload:
 *     name n_dof median_ms min_ms p99_ms iterations turned bytes checksum | force matrix solve remesh (mean ms)
 * over 300 steps after 50 to warm up; `turned` tets per step; the checksum is the sum of |u| at the end. remesh is the
 * time of the remesher with its changes of the matrix. Asserts nothing. */
#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#include "softbody.h"

#include "needle.h"

#include "measure.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static size_t bytes_given;

enum { WARM = 50, STEPS = 300, LINE = 64 };

typedef struct scene {
    sb_mesh mesh;
    ndl_tissue *tissue;
    ndl_remesh *remesh;
    int line[LINE], line_count;
    sb_vec3 entry;
    double remeshing;
} scene;

static int make_scene(scene *s, sb_real lazy, int needle)
{
    ndl_tissue_material gel;
    ndl_tissue_def def = ndl_default_tissue_def();
    ndl_remesh_def remesh = ndl_default_remesh_def();
    memset(s, 0, sizeof *s);
    if (sb_mesh_beam(SB_TET4, 17, 11, 12, sb_v3((sb_real)0.085, (sb_real)0.055, (sb_real)0.06), NULL, &s->mesh, NULL))
        return 0;
    gel.young = (sb_real)8e4;
    gel.poisson = (sb_real)0.45;
    gel.density = 1000;
    def.mesh = &s->mesh;
    def.materials = &gel;
    def.material_count = 1;
    def.gravity = sb_v3(0, 0, (sb_real)-9.81);
    def.lazy_angle = lazy;
    def.clock = now;
    def.allocator = counting_allocator(&bytes_given);
    def.jobs = jobs_asked_for();
    bytes_given = 0;
    if (ndl_tissue_create(&def, &s->tissue, NULL) != SB_OK)
        return 0;
    for (int i = 0; i < s->mesh.node_count; i++) {
        sb_vec3 X = s->mesh.nodes[i];
        if (X.z < (sb_real)1e-6)
            ndl_tissue_fix(s->tissue, i);
        else if (sb_abs(X.x - (sb_real)0.04) < (sb_real)1e-6 && sb_abs(X.y - (sb_real)0.025) < (sb_real)1e-6 &&
                 X.z > (sb_real)0.02 && s->line_count < LINE)
            s->line[s->line_count++] = i;
    }
    remesh.tissue = ndl_tissue_get_mesh(s->tissue);
    return !needle || ndl_remesh_create(&remesh, &s->remesh, NULL) == SB_OK;
}

/* 100 steps in, 100 out. */
static void move_needle(scene *s, int step)
{
    int phase = step % 200;
    double begin = now();
    if (phase == 0) {
        ndl_surface_hit hit;
        ndl_remesh_info info;
        sb_vec3 top = sb_v3((sb_real)0.0523, (sb_real)0.0271, (sb_real)0.08);
        ndl_remesh_withdraw(s->remesh, 0, NULL, NULL);
        if (ndl_tissue_mesh_hit(ndl_tissue_get_mesh(s->tissue), top, sb_v3(top.x, top.y, 0), &hit) &&
            ndl_remesh_puncture(s->remesh, 0, &hit, &info, NULL) == SB_OK)
            s->entry = info.X;
    } else {
        sb_real depth = (sb_real)(3e-4 * (phase <= 100 ? phase : 200 - phase));
        sb_vec3 X = sb_v3_madd(s->entry, -depth, sb_v3((sb_real)0.1, 0, 1));
        if (phase <= 100)
            ndl_remesh_penetrate(s->remesh, 0, X, NULL, NULL);
        else
            ndl_remesh_retract(s->remesh, 0, X, NULL, NULL);
    }
    s->remeshing = now() - begin;
}

static void run(const char *name, sb_real lazy, int needle)
{
    double times[STEPS], phases[4] = {0, 0, 0, 0}, sum = 0;
    int iterations = 0, turned = 0;
    const ndl_tissue_mesh *at;
    scene s;
    if (!make_scene(&s, lazy, needle)) {
        printf("%s: no scene\n", name);
        return;
    }
    at = ndl_tissue_get_mesh(s.tissue);
    for (int k = 0; k < WARM + STEPS; k++) {
        ndl_tissue_info info;
        sb_real sway, weight;
        sb_sin_cos((sb_real)0.05 * (sb_real)k, &sway, &weight);
        for (int i = 0; i < s.line_count && !needle; i++)
            ndl_tissue_set_force(s.tissue, s.line[i], sb_v3((sb_real)0.02 * sway, 0, (sb_real)-0.05));
        if (needle)
            move_needle(&s, k);
        if (ndl_tissue_step(s.tissue, (sb_real)0.02, &info, NULL) != SB_OK || k < WARM)
            continue;
        times[k - WARM] = 1e3 * (info.seconds_total + s.remeshing);
        phases[0] += 1e3 * info.seconds_force / (int)STEPS;
        phases[1] += 1e3 * info.seconds_matrix / (int)STEPS;
        phases[2] += 1e3 * info.seconds_solve / (int)STEPS;
        phases[3] += 1e3 * s.remeshing / (int)STEPS;
        iterations += info.iterations;
        turned += info.refreshed;
    }
    for (int i = 0; i < at->node_end; i++)
        if (at->node_flags[i])
            sum += (double)sb_v3_norm(sb_v3_sub(at->x[i], at->X[i]));
    qsort(times, STEPS, sizeof times[0], ascending);
    printf("%s %d %.3f %.3f %.3f %.1f %d %lu %.9g | %.3f %.3f %.3f %.3f\n", name, 3 * s.mesh.node_count,
           times[STEPS / 2], times[0], times[STEPS * 99 / 100], (double)iterations / (int)STEPS, turned / (int)STEPS,
           (unsigned long)bytes_given, sum, phases[0], phases[1], phases[2], phases[3]);
    ndl_remesh_destroy(s.remesh);
    ndl_tissue_destroy(s.tissue);
    sb_mesh_free(&s.mesh);
}

int main(void)
{
    run("tissue_13k", (sb_real)0.01, 0);
    run("tissue_13k_turned", 0, 0);
    run("tissue_13k_needle", (sb_real)0.01, 1);
    return 0;
}
