/* race_machine: what the machine gives, and where the product of a system's matrix stands under that roof. Arguments:
 * files of race_write. Prints
 *     machine what threads value     what: memory or cache (triad, GB/s), peak (multiplications and additions, Gflop/s)
 *     product system threads ms bytes flops */
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "race.h"

#if defined(_OPENMP)
#include <omp.h>
#endif

/* a = b + 3 c over arrays of `count` doubles, GB/s, the best of a few. */
static double triad(size_t count, int repeats)
{
    double *a = (double *)race_take(count, sizeof(double)), *b = (double *)race_take(count, sizeof(double));
    double *c = (double *)race_take(count, sizeof(double)), best = 0;
    long n = (long)count;
#pragma omp parallel for schedule(static)
    for (long i = 0; i < n; i++)
        a[i] = 0, b[i] = 1, c[i] = 2;
    for (int k = 0; k < 9; k++) {
        double start = race_seconds(), took;
        for (int r = 0; r < repeats; r++) {
#pragma omp parallel for schedule(static)
            for (long i = 0; i < n; i++)
                a[i] = b[i] + 3 * c[i];
        }
        took = race_seconds() - start;
        best = fmax(best, 24e-9 * (double)count * repeats / took);
    }
    if (a[count / 2] != 7)
        printf("# the triad went wrong\n");
    free(a);
    free(b);
    free(c);
    return best;
}

/* Multiplications and additions that wait for nothing, Gflop/s of all threads. */
static double peak(int threads)
{
    enum { WIDTH = 64, ROUNDS = 2000000 };
    double best = 0, keep = 0;
    for (int k = 0; k < 5; k++) {
        double start = race_seconds();
#pragma omp parallel for schedule(static, 1) reduction(+ : keep)
        for (int t = 0; t < threads; t++) {
            double v[WIDTH];
            for (int i = 0; i < WIDTH; i++)
                v[i] = 1 + i;
            for (int r = 0; r < ROUNDS; r++)
                for (int i = 0; i < WIDTH; i++)
                    v[i] = v[i] * 0.999999 + 1e-6;
            for (int i = 0; i < WIDTH; i++)
                keep += v[i];
        }
        best = fmax(best, 2e-9 * WIDTH * (double)ROUNDS * threads / (race_seconds() - start));
    }
    if (!(keep > 0))
        printf("# the peak went wrong\n");
    return best;
}

static void product(const race_system *s, const sb_jobs *jobs)
{
    sb_matrix a;
    double *x = (double *)race_take((size_t)s->n, sizeof(double));
    double *y = (double *)race_take((size_t)s->n, sizeof(double));
    double least = 1e30, begun = race_seconds();
    if (sb_matrix_create(s->nodes, s->cell_count, s->corners, NULL, s->cells, NULL, &a, NULL) != SB_OK)
        exit(1);
    memcpy(a.blocks, s->values, 9 * (size_t)s->blocks * sizeof(double));
    memcpy(x, s->rhs, (size_t)s->n * sizeof(double));
    while (race_seconds() - begun < 1) {
        double start = race_seconds();
        sb_matrix_multiply(&a, x, y, jobs);
        least = fmin(least, race_seconds() - start);
    }
    printf("product %s %d %.4f %.0f %.0f\n", s->name, race_threads(), 1e3 * least,
           76.0 * s->blocks + 4.0 * s->nodes + 16.0 * s->n, 18.0 * s->blocks);
    fflush(stdout);
    sb_matrix_free(&a);
    free(x);
    free(y);
}

int main(int argc, char **argv)
{
    sb_jobs jobs = {NULL, NULL};
    int threads = race_threads();
#if defined(SB_USE_OPENMP)
    if (threads > 1)
        jobs = sb_jobs_openmp();
#endif
    printf("machine memory %d %.2f\n", threads, triad(20000000, 1));
    printf("machine cache %d %.2f\n", threads, triad(400000, 200));
    printf("machine peak %d %.2f\n", threads, peak(threads));
    for (int k = 1; k < argc; k++) {
        race_system s;
        race_read(argv[k], &s);
        product(&s, &jobs);
        race_free(&s);
    }
    return 0;
}
