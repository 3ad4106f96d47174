/* bench_needle: whole steps of a needle in tissue.
 *
 *     needle_prostate   the phantom that examples/needle_prostate.c makes (13,295 tets, 2,840 nodes; see
 *                       examples/phantom.h), a nitinol needle with a bevel fed at 1 cm/s for 8 s, dt 20 ms,
 *                       residual 1e-3
 *     needle_program    the same, for 6 s, then turned by half a turn at rest, fed for 2 s and drawn out
 *
 * One line per workload:
 *     name n_dof median_ms min_ms p99_ms iterations bytes checksum | body couple needle remesh (mean ms);
 *     trials mean/max; consistent %
 * without the first 50 steps; iterations per step; the checksum is the sum of |u| at the end of a second run, at a
 * tolerance of 1e-8. Asserts nothing. */
#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#include "softbody.h"

#include "needle.h"

#include "examples/phantom.h"

#include "measure.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static size_t bytes_given;

enum { WARM = 50, MOST_STEPS = 1000 };

static int make_scene(phantom *p, sb_real tolerance)
{
    sb_body_def def = phantom_default_body_def();
    sb_error error;
    memset(p, 0, sizeof *p);
    def.clock = now;
    def.tolerance = tolerance;
    def.max_iterations = 5000;
    def.allocator = counting_allocator(&bytes_given);
    def.jobs = jobs_asked_for();
    bytes_given = 0;
    return phantom_make_mesh(&p->mesh, &error) == SB_OK && phantom_survey(p, &error) == SB_OK &&
           phantom_make_tissue(p, &def, &error) == SB_OK && phantom_make_needle(p, 7, sb_v3(0, 0, 0), &error) == SB_OK;
}

static ndl_command insert(int step)
{
    ndl_command command;
    (void)step;
    memset(&command, 0, sizeof command);
    command.insertion = (sb_real)0.01;
    return command;
}

static ndl_command program(int step)
{
    ndl_command command = insert(step);
    if (step >= 300 && step < 340) {
        command.insertion = 0;
        command.twist = (sb_real)(3.14159265358979 / 0.8);
    } else if (step >= 440) {
        command.insertion = (sb_real)-0.012;
    }
    return command;
}

/* Sum of |u| after a run. */
static double sum_displacements(ndl_command (*command_at)(int step), int steps)
{
    double sum = 0;
    phantom p;
    if (!make_scene(&p, (sb_real)1e-8))
        return 0;
    for (int k = 0; k < steps; k++) {
        ndl_command command = command_at(k);
        ndl_step(p.tissue, &p.needle, 1, (sb_real)0.02, &command, NULL, NULL);
    }
    for (int i = 0; i < sb_body_node_count(p.tissue); i++)
        sum += (double)sb_v3_norm(sb_body_displacements(p.tissue)[i]); /* 0 where there is no node */
    phantom_free(&p);
    return sum;
}

static void run(const char *name, ndl_command (*command_at)(int step), int steps)
{
    static double times[MOST_STEPS];
    double phases[4] = {0, 0, 0, 0};
    int iterations = 0, trials = 0, most = 0, consistent = 0, counted = steps - WARM, n_dof;
    size_t bytes;
    phantom p;
    if (!make_scene(&p, (sb_real)1e-3)) {
        printf("%s: no scene\n", name);
        return;
    }
    for (int k = 0; k < steps; k++) {
        ndl_command command = command_at(k);
        ndl_step_info info;
        sb_error error;
        if (ndl_step(p.tissue, &p.needle, 1, (sb_real)0.02, &command, &info, &error) != SB_OK)
            printf("%s: step %d: %s\n", name, k, error.message);
        if (k < WARM)
            continue;
        times[k - WARM] = 1e3 * info.seconds_total;
        phases[0] += 1e3 * info.seconds_body / counted;
        phases[1] += 1e3 * info.seconds_couple / counted;
        phases[2] += 1e3 * info.seconds_needle / counted;
        phases[3] += 1e3 * info.seconds_remesh / counted;
        iterations += info.iterations;
        trials += info.trials;
        most = info.trials > most ? info.trials : most;
        consistent += info.consistent;
    }
    bytes = bytes_given;
    n_dof = 3 * p.mesh.node_count;
    phantom_free(&p);
    qsort(times, (size_t)counted, sizeof times[0], ascending);
    printf("%s %d %.3f %.3f %.3f %.1f %lu %.9g | %.3f %.3f %.3f %.3f; %.2f/%d; %.2f\n", name, n_dof, times[counted / 2],
           times[0], times[counted * 99 / 100], (double)iterations / counted, (unsigned long)bytes,
           sum_displacements(command_at, steps), phases[0], phases[1], phases[2], phases[3], (double)trials / counted,
           most, 100.0 * consistent / counted);
}

int main(void)
{
    run("needle_prostate", insert, 400);
    run("needle_program", program, 600);
    return 0;
}
