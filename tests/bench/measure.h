/* measure.h: what every benchmark measures with: wall time, medians, bytes given, and the threads it was asked for.
 * Comes after softbody.h. */
#ifndef MEASURE_H
#define MEASURE_H

#include <stdlib.h>
#include <time.h>

/* Wall time (s). */
static inline double now(void)
{
    struct timespec t;
    timespec_get(&t, TIME_UTC);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* For qsort: doubles, the least first. */
static inline int ascending(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Sorts the values. */
static inline double median(double *values, int count)
{
    qsort(values, (size_t)count, sizeof values[0], ascending);
    return values[count / 2];
}

static inline void *measure_alloc(void *user, size_t bytes)
{
    *(size_t *)user += bytes;
    return malloc(bytes);
}
static inline void measure_release(void *user, void *pointer)
{
    (void)user;
    free(pointer);
}

/* An allocator that adds what it gives to *given. */
static inline sb_allocator counting_allocator(size_t *given)
{
    sb_allocator allocator = {measure_alloc, measure_release, NULL};
    allocator.user = given;
    return allocator;
}

/* OpenMP's threads when OMP_NUM_THREADS asks for more than one, else the caller's thread alone. */
static inline sb_jobs jobs_asked_for(void)
{
    sb_jobs none = {NULL, NULL};
#if defined(SB_USE_OPENMP)
    if (getenv("OMP_NUM_THREADS") && atoi(getenv("OMP_NUM_THREADS")) > 1)
        return sb_jobs_openmp();
#endif
    return none;
}

#endif
