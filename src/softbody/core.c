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

/* ---- memory ---- */

SBI_API int sbi_size_add(size_t *total, size_t count, size_t size)
{
    if (size && count > ((size_t)-1 - *total) / size)
        return 0;
    *total += count * size;
    return 1;
}

SBI_API void *sbi_alloc(const sb_allocator *allocator, size_t count, size_t size)
{
    size_t bytes = 0;
    if (!sbi_size_add(&bytes, count, size))
        return NULL;
    if (bytes == 0)
        bytes = 1;
    if (allocator && allocator->alloc)
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
    if (allocator && allocator->alloc)
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

#if defined(SB_USE_OPENMP)
#if defined(_OPENMP) && _OPENMP >= 201107 /* 3.1: atomic capture */
enum { SBI_OPENMP_RANGES = 64 }; /* and threads at most */

/* Tasks that a thread has first claim to, a cache line apart from those of others. */
typedef struct sbi_openmp_range {
    int next, end;
    char apart[64 - 2 * sizeof(int)];
} sbi_openmp_range;

/* The next task of a range, or -1. */
static int sbi_openmp_take(sbi_openmp_range *range)
{
    int index;
#pragma omp atomic capture
    index = range->next++;
    return index < range->end ? index : -1;
}

/* Each thread runs the same share of the tasks every time, so that what it wrote in one loop is in its own cache in
 * the next; whoever is done helps the others. There are as many threads however few tasks there are: a runtime ends
 * those that one loop does not need, and starts them anew for the next. */
static void sbi_openmp_run(void *user, sb_task task, void *task_user, int count)
{
    sbi_openmp_range ranges[SBI_OPENMP_RANGES];
    int threads = sbi_min_int(omp_get_max_threads(), SBI_OPENMP_RANGES);
    (void)user;
    for (int k = 0; k < threads; k++) {
        ranges[k].next = (int)((int64_t)count * k / threads);
        ranges[k].end = (int)((int64_t)count * (k + 1) / threads);
    }
#pragma omp parallel num_threads(threads) if (threads > 1)
    for (int k = 0; k < threads; k++) {
        sbi_openmp_range *range = ranges + (omp_get_thread_num() + k) % threads;
        for (int i = sbi_openmp_take(range); i >= 0; i = sbi_openmp_take(range))
            task(task_user, i);
    }
}
#else
static void sbi_openmp_run(void *user, sb_task task, void *task_user, int count)
{
    (void)user;
#pragma omp parallel for schedule(dynamic, 1)
    for (int i = 0; i < count; i++)
        task(task_user, i);
}
#endif

SB_API sb_jobs sb_jobs_openmp(void)
{
    sb_jobs jobs;
    jobs.run = sbi_openmp_run;
    jobs.user = NULL;
    return jobs;
}
#endif
