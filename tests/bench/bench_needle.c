/* bench_needle: whole steps of a needle in tissue.
 *
 *     needle_prostate   the phantom that examples/needle_prostate.c makes (13,295 tets, 2,840 nodes; see
 *                       examples/phantom.h), a nitinol needle with a bevel fed at 1 cm/s for 8 s, dt 20 ms, at the
 *                       phantom's tolerance
 *     needle_program    the same, for 6 s, then turned by half a turn at rest, fed for 2 s and drawn out
 *     needle_1khz       the same needle fed for 1 s, dt 1 ms
 *     needle_held, needle_held_1khz   the first and the last with NDL_EMBED, the default of needles
 *     needle_kept, needle_kept_1khz   these with tangents that are kept until an element has turned by 0.05
 *
 * One line per workload:
 *     name n_dof median_ms min_ms p99_ms max_ms iterations bytes warm checksum | body couple needle remesh (mean ms);
 *     trials mean/max; consistent %
 * without the first 50 steps, in which what was given out counts as bytes, and afterwards as warm; iterations per step;
 * the checksum is the sum of |u| at the end of a second run, at a tolerance of 1e-8.
 *
 *     bench_needle iterations   those of needle_prostate, and those of a twin without a needle that gets the needle's
 *                               forces as loads
 *     bench_needle accuracy     the force on the base and the tip of needle_prostate for some tolerances, against 1e-9:
 *                               steps until remeshing differs, root mean square of the force's error over that of the
 *                               force, largest error (N), tip (m), iterations per step
 * Asserts nothing. */
#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#include "softbody.h"

#include "needle.h"

#include "examples/phantom.h"

#include "measure.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static size_t bytes_given;

enum { WARM = 50, MOST_STEPS = 1000 };

/* How a scene is stepped. */
typedef struct way {
    ndl_follow follow;
    sb_real angle; /* that tangents are kept up to */
} way;

static const way remeshes = {NDL_REMESH, 0}, embeds = {NDL_EMBED, 0}, keeps = {NDL_EMBED, (sb_real)0.05};

/* tolerance 0: the phantom's. */
static int make_scene(phantom *p, way how, sb_real tolerance)
{
    sb_body_def def = phantom_default_body_def();
    sb_error error;
    memset(p, 0, sizeof *p);
    p->follow = how.follow;
    def.clock = now;
    def.tolerance = tolerance > 0 ? tolerance : def.tolerance;
    def.max_iterations = 5000;
    def.allocator = counting_allocator(&bytes_given);
    def.jobs = jobs_asked_for();
    bytes_given = 0;
    return phantom_make_mesh(&p->mesh, &error) == SB_OK && phantom_survey(p, &error) == SB_OK &&
           phantom_make_tissue(p, &def, &error) == SB_OK &&
           (how.angle == 0 || sb_body_keep_tangent(p->tissue, how.angle, &error) == SB_OK) &&
           phantom_make_needle(p, 7, sb_v3(0, 0, 0), &error) == SB_OK;
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
static double sum_displacements(way how, ndl_command (*command_at)(int step), double dt, int steps)
{
    double sum = 0;
    phantom p;
    if (!make_scene(&p, how, (sb_real)1e-8))
        return 0;
    for (int k = 0; k < steps; k++) {
        ndl_command command = command_at(k);
        ndl_step(p.tissue, &p.needle, 1, (sb_real)dt, &command, NULL, NULL);
    }
    for (int i = 0; i < sb_body_node_count(p.tissue); i++)
        sum += (double)sb_v3_norm(sb_body_displacements(p.tissue)[i]); /* 0 where there is no node */
    phantom_free(&p);
    return sum;
}

static void run(const char *name, way how, ndl_command (*command_at)(int step), double dt, int steps)
{
    static double times[MOST_STEPS];
    double phases[4] = {0, 0, 0, 0};
    int iterations = 0, trials = 0, most = 0, consistent = 0, counted = steps - WARM, n_dof;
    size_t bytes = 0, warm;
    phantom p;
    if (!make_scene(&p, how, 0)) {
        printf("%s: no scene\n", name);
        return;
    }
    for (int k = 0; k < steps; k++) {
        ndl_command command = command_at(k);
        ndl_step_info info;
        sb_error error;
        if (ndl_step(p.tissue, &p.needle, 1, (sb_real)dt, &command, &info, &error) != SB_OK)
            printf("%s: step %d: %s\n", name, k, error.message);
        if (k < WARM) {
            bytes = bytes_given;
            continue;
        }
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
    warm = bytes_given - bytes;
    n_dof = 3 * p.mesh.node_count;
    phantom_free(&p);
    qsort(times, (size_t)counted, sizeof times[0], ascending);
    printf("%s %d %.3f %.3f %.3f %.3f %.1f %lu %lu %.9g | %.3f %.3f %.3f %.3f; %.2f/%d; %.2f\n", name, n_dof,
           times[counted / 2], times[0], times[counted * 99 / 100], times[counted - 1], (double)iterations / counted,
           (unsigned long)bytes, (unsigned long)warm, sum_displacements(how, command_at, dt, steps), phases[0],
           phases[1], phases[2], phases[3], (double)trials / counted, most, 100.0 * consistent / counted);
}

/* ---- iterations beside those without a needle ---- */

/* Of the twin's nodes the one nearest to where a node of the body lies in the material: it has none that remeshing
 * made. */
static int nearest_node(const sb_mesh *mesh, sb_vec3 X)
{
    int nearest = 0;
    sb_real least = sb_v3_norm(sb_v3_sub(mesh->nodes[0], X));
    for (int j = 1; j < mesh->node_count; j++) {
        sb_real distance = sb_v3_norm(sb_v3_sub(mesh->nodes[j], X));
        if (distance < least)
            least = distance, nearest = j;
    }
    return nearest;
}

static void load_as_needle(const phantom *p, phantom *twin)
{
    const ndl_rod *rod = ndl_needle_rod(p->needle);
    sb_body_clear_loads(twin->tissue);
    for (int i = ndl_needle_entry(p->needle); i < ndl_rod_node_count(rod); i++) {
        int node = ndl_needle_body_node(p->needle, i), at;
        sb_vec3 force = sb_v3_scale(-1, ndl_needle_contact_force(p->needle, i));
        if (node < 0)
            continue;
        at = nearest_node(&twin->mesh,
                          sb_v3_sub(sb_body_positions(p->tissue)[node], sb_body_displacements(p->tissue)[node]));
        sb_body_add_forces(twin->tissue, &at, 1, &force, 0);
    }
}

static void compare_iterations(int steps)
{
    int with = 0, without = 0;
    phantom p, twin;
    if (!make_scene(&p, remeshes, 0) || !make_scene(&twin, remeshes, 0)) {
        printf("no scene\n");
        return;
    }
    ndl_needle_destroy(twin.needle);
    twin.needle = NULL;
    for (int k = 0; k < steps; k++) {
        ndl_command command = insert(k);
        ndl_step_info info;
        sb_step_info alone;
        ndl_step(p.tissue, &p.needle, 1, (sb_real)0.02, &command, &info, NULL);
        load_as_needle(&p, &twin);
        sb_body_step(twin.tissue, (sb_real)0.02, &alone);
        with += k < WARM ? 0 : info.iterations;
        without += k < WARM ? 0 : alone.pcg_iterations;
    }
    printf("needle_iterations with %.2f without %.2f ratio %.2f\n", (double)with / (steps - WARM),
           (double)without / (steps - WARM), (double)with / without);
    phantom_free(&p);
    phantom_free(&twin);
}

/* ---- accuracy of the force ---- */

typedef struct feel {
    sb_vec3 force, tip;
    int operations; /* of the remesher, up to here */
} feel;

/* Iterations of all steps. */
static int feel_run(sb_real tolerance, feel *felt, int steps)
{
    int iterations = 0, operations = 0;
    phantom p;
    if (!make_scene(&p, remeshes, tolerance))
        return 0;
    for (int k = 0; k < steps; k++) {
        const ndl_rod *rod = ndl_needle_rod(p.needle);
        ndl_command command = insert(k);
        ndl_step_info info;
        ndl_step(p.tissue, &p.needle, 1, (sb_real)0.02, &command, &info, NULL);
        iterations += info.iterations;
        operations += info.operations;
        ndl_needle_base_wrench(p.needle, &felt[k].force, NULL);
        felt[k].tip = ndl_rod_positions(rod)[ndl_rod_node_count(rod) - 1];
        felt[k].operations = operations;
    }
    phantom_free(&p);
    return iterations;
}

static void compare_accuracy(int steps)
{
    static const double tolerances[] = {1e-4, 5e-4, 2e-3, 5e-3, 1e-2};
    static feel right[MOST_STEPS], felt[MOST_STEPS];
    feel_run((sb_real)1e-9, right, steps);
    for (int t = 0; t < 5; t++) {
        int iterations = feel_run((sb_real)tolerances[t], felt, steps), k;
        double off = 0, all = 0, most = 0, tip = 0;
        for (k = 0; k < steps && felt[k].operations == right[k].operations; k++) {
            double error = (double)sb_v3_norm(sb_v3_sub(felt[k].force, right[k].force));
            double moved = (double)sb_v3_norm(sb_v3_sub(felt[k].tip, right[k].tip));
            off += error * error;
            all += (double)sb_v3_dot(right[k].force, right[k].force);
            most = error > most ? error : most;
            tip = moved > tip ? moved : tip;
        }
        printf("needle_accuracy %g steps %d rms %.2g largest_N %.2g tip_m %.2g iterations %.2f\n", tolerances[t], k,
               all > 0 ? sqrt(off / all) : 0, most, tip, (double)iterations / steps);
    }
}

int main(int argc, char **argv)
{
    if (argc > 1 && strcmp(argv[1], "iterations") == 0) {
        compare_iterations(400);
    } else if (argc > 1 && strcmp(argv[1], "accuracy") == 0) {
        compare_accuracy(400);
    } else {
        run("needle_prostate", remeshes, insert, 0.02, 400);
        run("needle_program", remeshes, program, 0.02, 600);
        run("needle_1khz", remeshes, insert, 0.001, 1000);
        run("needle_held", embeds, insert, 0.02, 400);
        run("needle_held_1khz", embeds, insert, 0.001, 1000);
        run("needle_kept", keeps, insert, 0.02, 400);
        run("needle_kept_1khz", keeps, insert, 0.001, 1000);
    }
    return 0;
}
