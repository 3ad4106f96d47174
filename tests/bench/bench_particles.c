/* bench_particles: steps of the thesis' beam of 10 x 40 x 10 particles (Brunet 2020, tables 3.1 and 3.2), bent by
 * gravity: corotated, E 2000 Pa, nu 0.3, rho 6.23, implicit Euler of 5 ms, residual 1e-3, one end held. Spacing 0.25 m.
 *
 *     particles_mls         point-based, least squares gradients, 10 neighbours
 *     particles_sph         the same with SPH gradients
 *     particles_grid_1      moving least squares, one point in each of 9 x 39 x 9 bricks, up to 10 neighbours
 *     particles_grid_8      eight points in each
 *     particles_hex8        the bricks as hex8 elements
 *
 * bench_particles [NAME [KIND]]: those whose names have NAME in them, with a preconditioner (sb_precond_kind; default
 * SB_PRECOND_AUTO, which makes no matrix for particles: in steps of 5 ms mass outweighs stiffness). One line per
 * workload:
 *     name n_dof points nodes_per_point blocks setup_ms median_ms min_ms p99_ms iterations checksum | force tangent
 *     precond solve (ms)
 * The times are over 200 steps after 20, iterations their mean, the checksum the sum of |u| after them. Asserts
 * nothing. */
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "measure.h"

#include <stdio.h>
#include <string.h>

enum { WARM = 20, STEPS = 200 };

static sb_precond_kind kind = SB_PRECOND_AUTO;

static void run(const char *name, const sb_mesh *mesh, const sb_domain *domain, double setup)
{
    sb_body_def def = sb_default_body_def();
    double times[STEPS], phases[4] = {0, 0, 0, 0}, iterations = 0, sum = 0;
    sb_body *body = NULL;
    sb_error error;
    def.mesh = mesh;
    def.domain = domain;
    def.material = sb_material_corotated(2000, (sb_real)0.3, (sb_real)6.23);
    def.gravity = sb_v3((sb_real)9.81, 0, 0);
    def.preconditioner = kind;
    def.clock = now;
    def.jobs = jobs_asked_for();
    if (sb_body_create(&def, &body, &error) != SB_OK) {
        printf("%s: %s\n", name, error.message);
        return;
    }
    for (int i = 0; i < mesh->node_count; i++)
        if (mesh->nodes[i].y < (sb_real)1e-6)
            sb_body_fix_nodes(body, &i, 1, SB_XYZ);
    for (int step = -WARM; step < STEPS; step++) {
        sb_step_info info;
        if (sb_body_step(body, (sb_real)0.005, &info) != SB_OK) {
            printf("%s: %s\n", name, info.error.message);
            break;
        }
        if (step < 0)
            continue;
        times[step] = 1e3 * info.seconds_total;
        phases[0] += 1e3 * info.seconds_force / (int)STEPS;
        phases[1] += 1e3 * info.seconds_tangent / (int)STEPS;
        phases[2] += 1e3 * info.seconds_precond / (int)STEPS;
        phases[3] += 1e3 * info.seconds_solve / (int)STEPS;
        iterations += (double)info.pcg_iterations / (int)STEPS;
    }
    for (int i = 0; i < mesh->node_count; i++)
        sum += (double)sb_v3_norm(sb_body_displacements(body)[i]);
    qsort(times, STEPS, sizeof times[0], ascending);
    printf("%s %d %d %d %d %.0f %.2f %.2f %.2f %.1f %.9e | %.2f %.2f %.2f %.2f\n", name, 3 * mesh->node_count,
           mesh->element_count, sb_mesh_element_width(mesh), sb_body_matrix_blocks(body), 1e3 * setup, times[STEPS / 2],
           times[0], times[STEPS - 1 - STEPS / 100], iterations, sum, phases[0], phases[1], phases[2], phases[3]);
    fflush(stdout);
    sb_body_destroy(body);
}

static void run_particles(const char *name, sb_particle_method method, int points, const sb_mesh *bricks,
                          const sb_surface *surface)
{
    sb_particles_def def = sb_default_particles_def();
    sb_particles particles;
    sb_error error;
    double began = now();
    def.method = method;
    def.points_per_cell = points;
    def.outer.surface = surface;
    def.points = bricks->nodes;
    def.point_count = bricks->node_count;
    def.counts[0] = def.counts[2] = 9;
    def.counts[1] = 39;
    if (sb_particles_create(&def, &particles, &error) != SB_OK) {
        printf("%s: %s\n", name, error.message);
        return;
    }
    run(name, &particles.mesh, &particles.domain, now() - began);
    sb_particles_free(&particles);
}

int main(int argc, char **argv)
{
    sb_mesh bricks, skin;
    sb_boundary boundary;
    sb_surface *surface = NULL;
    const char *only = argc > 1 ? argv[1] : "";
    static const struct {
        const char *name;
        sb_particle_method method;
        int points;
    } all[4] = {{"particles_mls", SB_PARTICLES_MLS, 1},
                {"particles_sph", SB_PARTICLES_SPH, 1},
                {"particles_grid_1", SB_PARTICLES_GRID, 1},
                {"particles_grid_8", SB_PARTICLES_GRID, 8}};
    if (argc > 2)
        kind = (sb_precond_kind)atoi(argv[2]);
    if (sb_mesh_beam(SB_HEX8, 9, 39, 9, sb_v3((sb_real)2.25, (sb_real)9.75, (sb_real)2.25), NULL, &bricks, NULL) ||
        sb_mesh_boundary(&bricks, 1, NULL, &boundary, NULL) ||
        sb_surface_triangulate(&boundary.surface, NULL, &skin, NULL) || sb_surface_create(&skin, NULL, &surface, NULL))
        return 1;
    for (int k = 0; k < 4; k++)
        if (strstr(all[k].name, only))
            run_particles(all[k].name, all[k].method, all[k].points, &bricks, surface);
    if (strstr("particles_hex8", only))
        run("particles_hex8", &bricks, NULL, 0);
    sb_surface_destroy(surface);
    sb_boundary_free(&boundary);
    sb_mesh_free(&skin);
    sb_mesh_free(&bricks);
    return 0;
}
