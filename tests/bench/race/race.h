/* race.h: what the racers share: systems on file, a clock, the true residual, a line of results. C99 and C++.
 *
 * A system is the matrix and right-hand side of one implicit step, written by race_write. The file, in the machine's
 * own order of bytes:
 *     "SBRACE02", int nodes, blocks, cells, corners, double poisson, int row_start[nodes + 1], int columns[blocks],
 *     double values[blocks][9] (3x3 blocks by rows), double positions[nodes][3], double rhs[nodes][3],
 *     int cells[cells][corners], unsigned char fixed[nodes]
 * A result is one line:
 *     race system unknowns solver threads tolerance setup_ms solve_ms iterations residual
 * with the least times of a few runs, and |b - A x| / |b| computed here, not by the solver. */
#ifndef RACE_H
#define RACE_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

typedef struct race_system {
    char name[64];
    int nodes, blocks, cell_count, corners;
    double poisson; /* Poisson's ratio of the material */
    int *row_start, *columns;
    double *values, *positions, *rhs;
    int *cells;
    unsigned char *fixed;
    /* the same by scalars, without zeros */
    int n;
    long entries;
    int *start, *column; /* [n + 1], [entries] */
    double *value;
} race_system;

static const double race_tolerances[2] = {1e-2, 1e-6};
enum { RACE_RUNS = 5 };                /* of which the least time counts; fewer where they take long: */
static const double race_patience = 4; /* seconds */

static inline double race_seconds(void)
{
    struct timespec t;
    timespec_get(&t, TIME_UTC);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static inline void *race_take(size_t count, size_t size)
{
    void *p = malloc(count * size + 1);
    if (!p) {
        fprintf(stderr, "race: no memory\n");
        exit(1);
    }
    return p;
}

static inline void *race_read_array(FILE *file, size_t count, size_t size)
{
    void *p = race_take(count, size);
    if (fread(p, size, count, file) != count) {
        fprintf(stderr, "race: a file is too short\n");
        exit(1);
    }
    return p;
}

static inline void race_expand(race_system *s)
{
    long used = 0;
    s->n = 3 * s->nodes;
    s->start = (int *)race_take((size_t)s->n + 1, sizeof(int));
    s->column = (int *)race_take(9 * (size_t)s->blocks, sizeof(int));
    s->value = (double *)race_take(9 * (size_t)s->blocks, sizeof(double));
    for (int i = 0; i < s->nodes; i++)
        for (int r = 0; r < 3; r++) {
            s->start[3 * i + r] = (int)used;
            for (int q = s->row_start[i]; q < s->row_start[i + 1]; q++)
                for (int c = 0; c < 3; c++) {
                    double v = s->values[9 * (size_t)q + (size_t)(3 * r + c)];
                    if (v != 0) {
                        s->column[used] = 3 * s->columns[q] + c;
                        s->value[used++] = v;
                    }
                }
        }
    s->start[s->n] = (int)used;
    s->entries = used;
}

/* Ends the program when the file is not one. */
static inline void race_read(const char *path, race_system *s)
{
    FILE *file = fopen(path, "rb");
    const char *slash = strrchr(path, '/'), *base = slash ? slash + 1 : path;
    char magic[8];
    int sizes[4];
    double poisson;
    if (!file || fread(magic, 1, 8, file) != 8 || memcmp(magic, "SBRACE02", 8) != 0 ||
        fread(sizes, sizeof(int), 4, file) != 4 || fread(&poisson, sizeof poisson, 1, file) != 1) {
        fprintf(stderr, "race: %s is not a system\n", path);
        exit(1);
    }
    memset(s, 0, sizeof *s);
    snprintf(s->name, sizeof s->name, "%.*s", (int)strcspn(base, "."), base);
    s->nodes = sizes[0], s->blocks = sizes[1], s->cell_count = sizes[2], s->corners = sizes[3], s->poisson = poisson;
    s->row_start = (int *)race_read_array(file, (size_t)s->nodes + 1, sizeof(int));
    s->columns = (int *)race_read_array(file, (size_t)s->blocks, sizeof(int));
    s->values = (double *)race_read_array(file, 9 * (size_t)s->blocks, sizeof(double));
    s->positions = (double *)race_read_array(file, 3 * (size_t)s->nodes, sizeof(double));
    s->rhs = (double *)race_read_array(file, 3 * (size_t)s->nodes, sizeof(double));
    s->cells = (int *)race_read_array(file, (size_t)s->cell_count * (size_t)s->corners, sizeof(int));
    s->fixed = (unsigned char *)race_read_array(file, (size_t)s->nodes, 1);
    fclose(file);
    race_expand(s);
}

static inline void race_free(race_system *s)
{
    void *arrays[10];
    arrays[0] = s->row_start, arrays[1] = s->columns, arrays[2] = s->values, arrays[3] = s->positions;
    arrays[4] = s->rhs, arrays[5] = s->cells, arrays[6] = s->fixed, arrays[7] = s->start, arrays[8] = s->column;
    arrays[9] = s->value;
    for (int k = 0; k < 10; k++)
        free(arrays[k]);
}

static inline double race_residual(const race_system *s, const double *x)
{
    double square = 0, size = 0;
    for (int i = 0; i < s->n; i++) {
        double r = s->rhs[i];
        for (int q = s->start[i]; q < s->start[i + 1]; q++)
            r -= s->value[q] * x[s->column[q]];
        square += r * r;
        size += s->rhs[i] * s->rhs[i];
    }
    return sqrt(square / size);
}

static inline void race_print(const race_system *s, const char *solver, int threads, double tolerance, double setup,
                              double solve, int iterations, double residual)
{
    printf("race %s %d %s %d %g %.3f %.3f %d %.2e\n", s->name, s->n, solver, threads, tolerance, 1e3 * setup,
           1e3 * solve, iterations, residual);
    fflush(stdout);
}

static inline int race_threads(void)
{
    const char *text = getenv("RACE_THREADS");
    return text && atoi(text) > 0 ? atoi(text) : 1;
}

#endif /* RACE_H */
