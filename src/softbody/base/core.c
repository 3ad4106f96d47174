/* core: results, checked sizes, allocation, jobs. */
#include "core.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#if defined(SB_USE_OPENMP) && defined(_OPENMP)
#include <omp.h>
#endif

SB_API const char *sb_result_string(sb_result result)
{
    switch (result) {
    case SB_OK: return "SB_OK";
    case SB_ERROR_MEMORY: return "SB_ERROR_MEMORY";
    case SB_ERROR_ARGUMENT: return "SB_ERROR_ARGUMENT";
    case SB_ERROR_NOT_FINITE: return "SB_ERROR_NOT_FINITE";
    case SB_ERROR_INDEX: return "SB_ERROR_INDEX";
    case SB_ERROR_FILE: return "SB_ERROR_FILE";
    case SB_ERROR_FORMAT: return "SB_ERROR_FORMAT";
    case SB_ERROR_UNSUPPORTED: return "SB_ERROR_UNSUPPORTED";
    case SB_ERROR_MESH: return "SB_ERROR_MESH";
    case SB_ERROR_MATERIAL: return "SB_ERROR_MATERIAL";
    case SB_ERROR_UNCONSTRAINED: return "SB_ERROR_UNCONSTRAINED";
    case SB_ERROR_INVERTED: return "SB_ERROR_INVERTED";
    case SB_ERROR_DIVERGED: return "SB_ERROR_DIVERGED";
    case SB_ERROR_NOT_CONVERGED: return "SB_ERROR_NOT_CONVERGED";
    case SB_ERROR_INDEFINITE: return "SB_ERROR_INDEFINITE";
    case SB_ERROR_STATE: return "SB_ERROR_STATE";
    case SB_ERROR_CANCELLED: return "SB_ERROR_CANCELLED";
    }
    return "unknown sb_result";
}

/* ---- errors ---- */

static void sbi_error_clear(sb_error *error, sb_result result)
{
    memset(error, 0, sizeof *error);
    error->result = result;
    error->element = -1;
    error->node = -1;
}

SBI_API sb_result sbi_fail(sb_error *error, sb_result result, const char *format, ...)
{
    if (error) {
        va_list arguments;
        va_start(arguments, format);
        sbi_error_clear(error, result);
        vsnprintf(error->message, sizeof error->message, format, arguments);
        va_end(arguments);
    }
    return result;
}

SBI_API sb_result sbi_fail_element(sb_error *error, sb_result result, int element, const char *format, ...)
{
    if (error) {
        va_list arguments;
        va_start(arguments, format);
        sbi_error_clear(error, result);
        error->element = element;
        vsnprintf(error->message, sizeof error->message, format, arguments);
        va_end(arguments);
    }
    return result;
}

SBI_API sb_result sbi_fail_node(sb_error *error, sb_result result, int node, const char *format, ...)
{
    if (error) {
        va_list arguments;
        va_start(arguments, format);
        sbi_error_clear(error, result);
        error->node = node;
        vsnprintf(error->message, sizeof error->message, format, arguments);
        va_end(arguments);
    }
    return result;
}

SBI_API void sbi_error_set_file(sb_error *error, const char *name)
{
    size_t length = strlen(name), room = sizeof error->file - 1;
    if (length > room)
        name += length - room;
    memcpy(error->file, name, length > room ? room + 1 : length + 1);
}

SBI_API sb_result sbi_fail_file(sb_error *error, sb_result result, const char *path, const char *why)
{
    sbi_fail(error, result, "%s", why);
    if (error)
        sbi_error_set_file(error, path);
    return result;
}

/* ---- memory ---- */

SBI_API int sbi_size_add(size_t *total, size_t count, size_t size)
{
    if (size && count > ((size_t)-1 - *total) / size)
        return 0;
    *total += count * size;
    return 1;
}

/* One that lacks a function is no allocator: memory is malloc's then, and free's. */
static int sbi_allocator_is_whole(const sb_allocator *allocator)
{
    return allocator && allocator->alloc && allocator->release;
}

SBI_API void *sbi_alloc(const sb_allocator *allocator, size_t count, size_t size)
{
    size_t bytes = 0;
    if (!sbi_size_add(&bytes, count, size))
        return NULL;
    if (bytes == 0)
        bytes = 1;
    if (sbi_allocator_is_whole(allocator))
        return allocator->alloc(allocator->user, bytes);
    return malloc(bytes);
}

SBI_API void *sbi_alloc_zeroed(const sb_allocator *allocator, size_t count, size_t size)
{
    void *pointer = sbi_alloc(allocator, count, size);
    if (pointer)
        memset(pointer, 0, count * size);
    return pointer;
}

SBI_API void sbi_free(const sb_allocator *allocator, void *pointer)
{
    if (!pointer)
        return;
    if (sbi_allocator_is_whole(allocator))
        allocator->release(allocator->user, pointer);
    else
        free(pointer);
}

SBI_API void *sbi_arena_take(sbi_arena *arena, size_t count, size_t size)
{
    size_t start = arena->used, end = start;
    if (!sbi_size_add(&end, count, size) || end > (size_t)-1 - 63) {
        arena->overflow = 1;
        return NULL;
    }
    arena->used = (end + 63) & ~(size_t)63;
    return arena->base ? arena->base + start : NULL;
}

/* ---- jobs ---- */

SBI_API void sbi_run(const sb_jobs *jobs, sb_task task, void *task_user, int count)
{
    if (jobs && jobs->run && count > 1) {
        jobs->run(jobs->user, task, task_user, count);
        return;
    }
    for (int i = 0; i < count; i++)
        task(task_user, i);
}

#if defined(SB_USE_OPENMP) && !defined(_OPENMP)
static void sbi_openmp_run(void *user, sb_task task, void *task_user, int count)
{
    (void)user;
    sbi_run(NULL, task, task_user, count);
}
#elif defined(SB_USE_OPENMP)
/* An OpenMP loop ends when each thread has come by, also one that another process keeps off its processor for ten
 * milliseconds or more while no task is left for it. The caller cannot leave without it, so it counts what such loops
 * lose against doing all tasks alone, and where they lose, works alone for several times as long before it tries again.
 * On a machine with nothing else to do no loop loses; on any other the losses stay a small share. */
enum { SBI_OPENMP_RANGES = 64 };             /* and threads at most */
static const double sbi_openmp_alone = 10;   /* seconds of work alone for each second lost */
static const double sbi_openmp_slice = 1e-3; /* s, shorter than what a system lets one process run before the next */
static const double sbi_openmp_longest = 1;  /* s of work alone at most, unless one loss was worth more */

/* What one calling thread has seen, in seconds. The only thing this library remembers outside of objects. */
typedef struct sbi_openmp_pace {
    double lost;   /* by loops on threads against loops alone, never below 0 */
    double helped; /* of loops on threads since work alone ended */
    double alone;  /* of work that is left to be done alone; 0 or less: threads work */
    double pause;  /* what alone began with when it was last set */
} sbi_openmp_pace;
static sbi_openmp_pace sbi_openmp_pace_of_thread;
#pragma omp threadprivate(sbi_openmp_pace_of_thread)

/* Tasks that a thread has first claim to, a cache line apart from those of others. */
typedef struct sbi_openmp_range {
    double busy; /* seconds that the thread spent on tasks, of any range */
    int next, end;
    char apart[64 - sizeof(double) - 2 * sizeof(int)];
} sbi_openmp_range;

#if _OPENMP >= 201107 /* 3.1: atomic capture */
/* The next task of a range, or -1. */
static int sbi_openmp_take(sbi_openmp_range *range)
{
    int index;
#pragma omp atomic capture
    index = range->next++;
    return index < range->end ? index : -1;
}

/* Each thread runs the same share of the tasks every time, so that what it wrote in one loop is in its own cache in
 * the next; a thread that is done helps the others. */
static void sbi_openmp_work(sbi_openmp_range *ranges, int threads, sb_task task, void *task_user, int count)
{
    (void)count;
    for (int k = 0; k < threads; k++) {
        sbi_openmp_range *range = ranges + (omp_get_thread_num() + k) % threads;
        for (int i = sbi_openmp_take(range); i >= 0; i = sbi_openmp_take(range))
            task(task_user, i);
    }
}
#else
static void sbi_openmp_work(sbi_openmp_range *ranges, int threads, sb_task task, void *task_user, int count)
{
    int i;
    (void)ranges;
    (void)threads;
#pragma omp for schedule(dynamic, 1) nowait
    for (i = 0; i < count; i++)
        task(task_user, i);
}
#endif

/* Does the tasks on all threads. Returns the seconds lost against doing them alone; gains are negative. There are as
 * many threads however few tasks there are: a runtime ends those that one loop does not need, and starts them anew for
 * the next. */
static double sbi_openmp_share(int threads, sb_task task, void *task_user, int count)
{
    sbi_openmp_range ranges[SBI_OPENMP_RANGES];
    double started = omp_get_wtime(), alone, most;
    for (int k = 0; k < threads; k++) {
        ranges[k].busy = 0;
        ranges[k].next = (int)((int64_t)count * k / threads);
        ranges[k].end = (int)((int64_t)count * (k + 1) / threads);
    }
#pragma omp parallel num_threads(threads) if (threads > 1)
    {
        double begun = omp_get_wtime();
        sbi_openmp_work(ranges, threads, task, task_user, count);
        ranges[omp_get_thread_num()].busy = omp_get_wtime() - begun;
    }
    alone = ranges[0].busy;
    most = 4 * ranges[0].busy +
           sbi_openmp_slice; /* longer than that a thread was not at work but kept off its processor */
    for (int k = 1; k < threads; k++)
        alone += ranges[k].busy < most ? ranges[k].busy : most;
    return omp_get_wtime() - started - alone;
}

/* Takes note of a loop on threads. A gain counts for no more than a slice: while the caller itself is kept off its
 * processor, threads seem to gain a lot. */
static void sbi_openmp_note(sbi_openmp_pace *pace, double took, double lost)
{
    pace->helped += took;
    pace->lost += lost > -sbi_openmp_slice ? lost : -sbi_openmp_slice;
    if (pace->lost < 0)
        pace->lost = 0;
    if (pace->lost <= 2 * sbi_openmp_slice)
        return;
    pace->alone = sbi_openmp_alone * pace->lost;
    if (pace->helped < pace->pause && pace->alone < 2 * pace->pause) /* lost again at once: wait longer each time */
        pace->alone = 2 * pace->pause < sbi_openmp_longest ? 2 * pace->pause : sbi_openmp_longest;
    pace->pause = pace->alone;
    pace->lost = pace->helped = 0;
}

static void sbi_openmp_run(void *user, sb_task task, void *task_user, int count)
{
    sbi_openmp_pace *pace = &sbi_openmp_pace_of_thread;
    int threads = sbi_min_int(omp_get_max_threads(), SBI_OPENMP_RANGES);
    double started;
    (void)user;
    if (threads < 2 || count < 2) {
        sbi_run(NULL, task, task_user, count);
        return;
    }
    started = omp_get_wtime();
    if (pace->alone > 0) {
        sbi_run(NULL, task, task_user, count);
        pace->alone -= omp_get_wtime() - started;
    } else {
        double lost = sbi_openmp_share(threads, task, task_user, count);
        sbi_openmp_note(pace, omp_get_wtime() - started, lost);
    }
}
#endif

#if defined(SB_USE_OPENMP)
SB_API sb_jobs sb_jobs_openmp(void)
{
    sb_jobs jobs;
    jobs.run = sbi_openmp_run;
    jobs.user = NULL;
    return jobs;
}
#endif
