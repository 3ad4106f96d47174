/* bench_busy: whole steps beside other processes that want the processor.
 *
 *     bench_busy [BUSY...]      numbers of busy processes, default 0 2 8 14
 *
 * Two beams of bench_step's scene, of 13,000 tet4 and of 1,300, are stepped by one thread and by OpenMP's threads
 * (OMP_NUM_THREADS, default all processors) in turns, so that both meet the same neighbours: 12 turns of at least 0.5 s
 * and 20 steps each. One line per number of busy processes, body and number of threads, ratio last:
 *     busy name threads steps mean_ms min_ms median_ms p99_ms worst_ms checksum | mean over mean of one thread
 * The ratio is the median over the turns, each against the turn of one thread just before it. Asserts nothing. POSIX
 * only: the busy processes are forked. */
#if defined(__unix__) || defined(__APPLE__)
#if !defined(_POSIX_C_SOURCE)
#define _POSIX_C_SOURCE 200809L
#endif
#include <signal.h>
#include <sys/types.h>
#include <sys/wait.h>
#include <unistd.h>
#define HAVE_FORK 1
#endif

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "measure.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#if defined(HAVE_FORK) && defined(_OPENMP)
#include <omp.h>

enum { TURNS = 12, LEAST_STEPS = 20, MOST_STEPS = 100000, MOST_BUSY = 64 };
static const double turn_seconds = 0.5;

/* The steps of one body by one number of threads, over all turns. */
typedef struct series {
    sb_body *body;
    double *times;
    int count;
    double means[TURNS];
} series;

static sb_body *make_body(const sb_mesh *mesh, int threads)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_error error;
    def.mesh = mesh;
    def.material = sb_material_corotated(50000, (sb_real)0.45, 1000);
    def.gravity = sb_v3(0, 0, (sb_real)-9.81);
    def.damping_stiffness = (sb_real)0.02;
    def.tolerance = (sb_real)1e-2;
    if (threads > 1)
        def.jobs = sb_jobs_openmp();
    if (sb_body_create(&def, &body, &error) != SB_OK) {
        fprintf(stderr, "bench_busy: %s\n", error.message);
        return NULL;
    }
    for (int i = 0; i < mesh->node_count; i++)
        if (mesh->nodes[i].x < (sb_real)1e-6)
            sb_body_fix_nodes(body, &i, 1, SB_XYZ);
    return body;
}

static void start_busy(pid_t *children, int count)
{
    for (int k = 0; k < count; k++) {
        children[k] = fork();
        if (children[k] == 0)
            for (volatile unsigned long spin = 0;; spin++)
                if (getppid() == 1)
                    _exit(0); /* the benchmark was killed */
    }
}

static void stop_busy(const pid_t *children, int count)
{
    for (int k = 0; k < count; k++)
        if (children[k] > 0) {
            kill(children[k], SIGKILL);
            waitpid(children[k], NULL, 0);
        }
}

static void take_turn(series *s, int turn)
{
    double started = now(), before = started;
    int steps = 0;
    while (s->count < MOST_STEPS && (steps < LEAST_STEPS || before - started < turn_seconds)) {
        double after;
        if (sb_body_step(s->body, (sb_real)0.01, NULL) != SB_OK)
            break;
        after = now();
        s->times[s->count++] = after - before;
        before = after;
        steps++;
    }
    s->means[turn] = (before - started) / (double)(steps > 0 ? steps : 1);
}

static void report(int busy, const char *name, int threads, series *s, double ratio)
{
    double total = 0, sum = 0;
    for (int k = 0; k < s->count; k++)
        total += s->times[k];
    for (int i = 0; i < 3; i++)
        sum += (double)sb_body_displacements(s->body)[i].z;
    if (s->count == 0)
        return;
    qsort(s->times, (size_t)s->count, sizeof s->times[0], ascending);
    printf("%2d %-14s %d %6d %8.3f %8.3f %8.3f %8.2f %8.2f %.6e | %.2f\n", busy, name, threads, s->count,
           1e3 * total / s->count, 1e3 * s->times[0], 1e3 * s->times[s->count / 2], 1e3 * s->times[s->count * 99 / 100],
           1e3 * s->times[s->count - 1], sum, ratio);
    fflush(stdout);
}

static void run(int busy, const char *name, const sb_mesh *mesh)
{
    pid_t children[MOST_BUSY];
    int threads[2];
    series both[2];
    double ratios[TURNS];
    memset(both, 0, sizeof both);
    threads[0] = 1;
    threads[1] = omp_get_max_threads();
    for (int k = 0; k < 2; k++) {
        both[k].body = make_body(mesh, threads[k]);
        both[k].times = (double *)malloc(MOST_STEPS * sizeof(double));
    }
    if (both[0].body && both[1].body && both[0].times && both[1].times) {
        start_busy(children, busy);
        for (int turn = 0; turn < TURNS; turn++) {
            take_turn(&both[0], turn);
            take_turn(&both[1], turn);
            ratios[turn] = both[1].means[turn] / both[0].means[turn];
        }
        stop_busy(children, busy);
        report(busy, name, threads[0], &both[0], 1);
        report(busy, name, threads[1], &both[1], median(ratios, TURNS));
    }
    for (int k = 0; k < 2; k++) {
        sb_body_destroy(both[k].body);
        free(both[k].times);
    }
}

static void run_beams(int busy)
{
    static const struct {
        const char *name;
        int nx, ny, nz;
    } beams[2] = {{"beam_tet4_13k", 28, 9, 9}, {"beam_tet4_1300", 14, 4, 4}};
    for (int k = 0; k < 2; k++) {
        sb_mesh mesh;
        if (sb_mesh_beam(SB_TET4, beams[k].nx, beams[k].ny, beams[k].nz,
                         sb_v3((sb_real)0.2, (sb_real)0.06, (sb_real)0.06), NULL, &mesh, NULL) != SB_OK)
            return;
        sb_mesh_reorder(&mesh, NULL, NULL, NULL);
        run(busy, beams[k].name, &mesh);
        sb_mesh_free(&mesh);
    }
}

int main(int argc, char **argv)
{
    static const int usual[4] = {0, 2, 8, 14};
    int given = argc > 1;
    for (int k = 0; k < (given ? argc - 1 : 4); k++) {
        int busy = given ? atoi(argv[k + 1]) : usual[k];
        if (busy < 0 || busy > MOST_BUSY) {
            fprintf(stderr, "usage: bench_busy [BUSY...], each from 0 to %d\n", MOST_BUSY);
            return 2;
        }
        run_beams(busy);
    }
    return 0;
}
#else
int main(void)
{
    printf("bench_busy needs fork and OpenMP\n");
    return 0;
}
#endif
