/* core: what every program relies on before it has a mesh. */
#include "softbody.h"

#include "check.h"

#if defined(SB_USE_OPENMP)
#include <omp.h>
#endif

static const sb_result all_results[] = {
    SB_OK,
    SB_ERROR_MEMORY,
    SB_ERROR_ARGUMENT,
    SB_ERROR_NOT_FINITE,
    SB_ERROR_INDEX,
    SB_ERROR_FILE,
    SB_ERROR_FORMAT,
    SB_ERROR_UNSUPPORTED,
    SB_ERROR_MESH,
    SB_ERROR_MATERIAL,
    SB_ERROR_UNCONSTRAINED,
    SB_ERROR_INVERTED,
    SB_ERROR_DIVERGED,
    SB_ERROR_NOT_CONVERGED,
    SB_ERROR_INDEFINITE,
    SB_ERROR_STATE,
    SB_ERROR_CANCELLED,
};
enum { RESULT_COUNT = (int)(sizeof all_results / sizeof all_results[0]) };

static void test_result_values(void)
{
    for (int i = 0; i < RESULT_COUNT; i++)
        CHECK_INT(all_results[i], -i); /* bindings hold these numbers */
}

static void test_result_strings(void)
{
    CHECK(strcmp(sb_result_string(SB_OK), "SB_OK") == 0);
    CHECK(strcmp(sb_result_string(SB_ERROR_DIVERGED), "SB_ERROR_DIVERGED") == 0);
    for (int i = 0; i < RESULT_COUNT; i++) {
        const char *name = sb_result_string(all_results[i]);
        CHECK(strncmp(name, "SB_", 3) == 0);
        for (int j = 0; j < i; j++)
            CHECK(strcmp(name, sb_result_string(all_results[j])) != 0);
    }
    CHECK(strcmp(sb_result_string((sb_result)7), "unknown sb_result") == 0);
    CHECK(strcmp(sb_result_string((sb_result)1), "unknown sb_result") == 0);
}

static void test_version(void)
{
    char expected[64];
    snprintf(expected, sizeof expected, "%d.%d.%d", SB_VERSION_MAJOR, SB_VERSION_MINOR, SB_VERSION_PATCH);
    CHECK(strcmp(SB_VERSION_STRING, expected) == 0);
}

/* volatile: the sums must be rounded to sb_real, not folded in a wider type */
static void test_scalar(void)
{
    volatile sb_real one = (sb_real)1, next = one + SB_EPSILON, same = one + SB_EPSILON / (sb_real)4;
    check_bad_numbers();
    volatile sb_real largest = SB_REAL_MAX, beyond = largest * (sb_real)2;
    CHECK_INT(sizeof(sb_real), SB_REAL_IS_FLOAT ? sizeof(float) : sizeof(double));
    CHECK(next > one);
    CHECK(same == one);
    CHECK(sb_is_finite(largest));
    CHECK(!sb_is_finite(beyond));
    CHECK(!sb_is_finite(-beyond));
    CHECK(!sb_is_finite(beyond - beyond));
    CHECK(sb_is_finite((sb_real)0));
}

#if defined(SB_USE_OPENMP)
static void count_call(void *user, int index) { ((int *)user)[index]++; }

/* Each task once, in regions of any size by turns, and in one that is within another. */
static void test_openmp_jobs(void)
{
    enum { TASKS = 1000 };
    static const int counts[7] = {TASKS, 1, 2, 65, TASKS, 3, 0};
    static int calls[TASKS + 1];
    sb_jobs jobs = sb_jobs_openmp();
    for (int k = 0; k < 7; k++) {
        memset(calls, 0, sizeof calls);
        jobs.run(jobs.user, count_call, calls, counts[k]);
        for (int i = 0; i <= TASKS; i++)
            CHECK_INT(calls[i], i < counts[k]);
    }
    memset(calls, 0, sizeof calls);
#pragma omp parallel for
    for (int part = 0; part < 4; part++)
        jobs.run(jobs.user, count_call, calls + part * (TASKS / 4), TASKS / 4);
    for (int i = 0; i <= TASKS; i++)
        CHECK_INT(calls[i], i < TASKS);
}

static void wait_for(double seconds)
{
    double started = omp_get_wtime();
    while (omp_get_wtime() - started < seconds)
        continue;
}

/* A thread that comes late: its tasks take a hundred times as long as the caller's, which notes whether it runs
 * alone. */
static void late_task(void *user, int index)
{
    (void)index;
    if (omp_get_thread_num() == 0) {
        wait_for(2e-4);
        *(int *)user = omp_in_parallel();
    } else {
        wait_for(2e-2);
    }
}

/* Where threads keep the caller waiting it works alone, and tries them again later. */
static void test_openmp_late_threads(void)
{
    sb_jobs jobs = sb_jobs_openmp();
    int usual = omp_get_max_threads(), together = 0, again = 0;
    omp_set_num_threads(2);
    for (int k = 0; k < 50; k++) {
        int shared = 0;
        jobs.run(jobs.user, late_task, &shared, 2);
        together += shared;
    }
    CHECK(together < 25);
    for (double started = omp_get_wtime(); !again && omp_get_wtime() - started < 60;)
        jobs.run(jobs.user, late_task, &again, 2);
    CHECK(again);
    omp_set_num_threads(usual);
}

typedef struct nested {
    sb_jobs jobs;
    int *calls;
    int each;
} nested;

static void nested_task(void *user, int index)
{
    const nested *n = (const nested *)user;
    n->jobs.run(n->jobs.user, count_call, n->calls + index * n->each, n->each);
}

/* More threads than processors, loops within loops, and two callers at once, a few hundred times: each task once. */
static void test_openmp_stress(void)
{
    enum { CALLERS = 2, OUTER = 8, EACH = 5, ROUNDS = 200 };
    static int calls[CALLERS * OUTER * EACH];
    int usual = omp_get_max_threads(), levels = omp_get_max_active_levels();
    sb_jobs jobs = sb_jobs_openmp();
    memset(calls, 0, sizeof calls);
    omp_set_num_threads(7);
    omp_set_max_active_levels(2);
    for (int round = 0; round < ROUNDS; round++) {
#pragma omp parallel for num_threads(CALLERS)
        for (int caller = 0; caller < CALLERS; caller++) {
            nested n;
            n.jobs = jobs;
            n.calls = calls + caller * OUTER * EACH;
            n.each = EACH;
            jobs.run(jobs.user, nested_task, &n, OUTER);
        }
    }
    for (int i = 0; i < CALLERS * OUTER * EACH; i++)
        CHECK_INT(calls[i], ROUNDS);
    omp_set_max_active_levels(levels);
    omp_set_num_threads(usual);
}
#define OPENMP_TEST                                                                                                    \
    {"openmp jobs", test_openmp_jobs}, {"openmp late threads", test_openmp_late_threads},                              \
        {"openmp stress", test_openmp_stress},
#else
#define OPENMP_TEST
#endif

CHECK_SUITE(core, OPENMP_TEST{"result values", test_result_values}, {"result strings", test_result_strings},
            {"version", test_version}, {"scalar type", test_scalar});
