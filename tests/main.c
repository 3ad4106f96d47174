/* main: runs the suites and ends with the line `N passed, N failed, N skipped`.
 *
 *     tests [K/N] [FILTER...]
 *
 * A FILTER is a suite (`dense`), the start of suite/test (`dense/inverse`) or the start of a test in any suite
 * (`/golden`); with a minus before it, it leaves tests out. K/N: each Nth suite only, from the Kth on, so that N
 * processes at a time run them all.
 *
 * With CHECK_TIMES in the environment each test prints the processor's seconds that it took.
 *
 * With CHECK_TRAPS (make test-host) an operation that overflows, is invalid or divides by zero ends its test as failed,
 * as in a host that unmasks these exceptions; the addresses printed are for addr2line.
 *
 * With CHECK_STACK (make test-host) each test runs in a thread of its own, whose stack is painted first, and fails when
 * it has used more than CHECK_STACK bytes, its own variables included.
 *
 * suites.h is written by the Makefile: one line SUITE(name) for each CHECK_SUITE in tests/test_*.c. */
#if defined(CHECK_TRAPS) || defined(CHECK_STACK)
#define _GNU_SOURCE 1 /* feenableexcept, pthread_attr_setstack */
#endif
#include <time.h>

#include "check.h"

#define SUITE(name) extern const check_suite check_suite_##name;
#include "suites.h"
#undef SUITE

typedef struct totals {
    int passed, failed, skipped;
} totals;

check_state check;

static const check_suite *const suites[] = {
#define SUITE(name) &check_suite_##name,
#include "suites.h"
#undef SUITE
};
enum { SUITE_COUNT = sizeof suites / sizeof suites[0] };

static int matches(const char *filter, const check_suite *suite, const check_case *test)
{
    char full_name[256];
    snprintf(full_name, sizeof full_name, "%s/%s", suite->name, test->name);
    if (filter[0] == '/')
        return strncmp(filter, full_name + strlen(suite->name), strlen(filter)) == 0;
    if (strchr(filter, '/'))
        return strncmp(filter, full_name, strlen(filter)) == 0;
    return strcmp(filter, suite->name) == 0;
}

static int is_selected(const check_suite *suite, const check_case *test, int filter_count, char **filters)
{
    int wanted = 1, has_wish = 0;
    for (int i = 0; i < filter_count; i++) {
        if (filters[i][0] == '-') {
            if (matches(filters[i] + 1, suite, test))
                return 0;
        } else {
            wanted = (has_wish && wanted) || matches(filters[i], suite, test);
            has_wish = 1;
        }
    }
    return wanted;
}

#if defined(CHECK_TRAPS)
#include <execinfo.h>
#include <fenv.h>
#include <setjmp.h>
#include <signal.h>
#include <unistd.h>

static sigjmp_buf after_trap;

void check_bad_numbers(void) { fedisableexcept(FE_ALL_EXCEPT); }

static void trapped(int signal_number, siginfo_t *info, void *context)
{
    void *frames[12];
    (void)signal_number;
    (void)context;
    printf("[%s] floating-point exception: %s\n", check.test,
           info->si_code == FPE_FLTOVF   ? "overflow"
           : info->si_code == FPE_FLTDIV ? "division by zero"
                                         : "invalid operation");
    fflush(stdout);
    backtrace_symbols_fd(frames, backtrace(frames, 12), STDOUT_FILENO);
    siglongjmp(after_trap, 1);
}

static void run_here(const check_case *test)
{
    struct sigaction action;
    memset(&action, 0, sizeof action);
    action.sa_sigaction = trapped;
    action.sa_flags = SA_SIGINFO;
    sigaction(SIGFPE, &action, NULL);
    if (sigsetjmp(after_trap, 1) == 0) {
        feenableexcept(FE_INVALID | FE_DIVBYZERO | FE_OVERFLOW);
        test->run();
    } else {
        check.failures++;
    }
    fedisableexcept(FE_ALL_EXCEPT);
    feclearexcept(FE_ALL_EXCEPT);
}
#else
void check_bad_numbers(void) {}
static void run_here(const check_case *test) { test->run(); }
#endif

#if defined(CHECK_STACK)
#include <pthread.h>

enum {
    STACK_ROOM = 1 << 20,
    STACK_PAINT = 0xA5,
    STACK_OVERHEAD = 8192 /* what libc keeps at the top of it, at most */
};

static void *run_on_stack(void *test)
{
    run_here((const check_case *)test);
    return NULL;
}

static void run_body(const check_case *test)
{
    static unsigned char *stack;
    size_t unused = 0;
    pthread_attr_t attributes;
    pthread_t thread;
    if (!stack)
        stack = (unsigned char *)aligned_alloc(4096, STACK_ROOM);
    if (!CHECK(stack != NULL))
        return;
    memset(stack, STACK_PAINT, STACK_ROOM);
    pthread_attr_init(&attributes);
    if (CHECK_INT(pthread_attr_setstack(&attributes, stack, STACK_ROOM), 0) &&
        CHECK_INT(pthread_create(&thread, &attributes, run_on_stack, (void *)(size_t)test), 0))
        CHECK_INT(pthread_join(thread, NULL), 0);
    pthread_attr_destroy(&attributes);
    while (unused < STACK_ROOM && stack[unused] == STACK_PAINT)
        unused++;
    if (getenv("CHECK_STACK"))
        printf("%7d bytes: %s\n", (int)(STACK_ROOM - unused), test->name);
    if (!CHECK(STACK_ROOM - unused <= CHECK_STACK + STACK_OVERHEAD))
        printf("    %d bytes of stack\n", (int)(STACK_ROOM - unused));
}
#else
static void run_body(const check_case *test) { run_here(test); }
#endif

static void run_test(const check_suite *suite, const check_case *test, totals *sum)
{
    clock_t start = clock();
    check.failures = 0;
    check.skips = 0;
    check.test = test->name;
    run_body(test);
    if (getenv("CHECK_TIMES"))
        printf("%8.2f s: %s/%s\n", (double)(clock() - start) / (double)CLOCKS_PER_SEC, suite->name, test->name);
    if (check.failures) {
        printf("FAILED: %s/%s\n", suite->name, test->name);
        sum->failed++;
    } else if (check.skips) {
        sum->skipped++;
    } else {
        sum->passed++;
    }
    fflush(stdout);
}

static void run_suite(const check_suite *suite, int filter_count, char **filters, totals *sum)
{
    totals own = {0, 0, 0};
    clock_t start = clock();
    for (const check_case *test = suite->cases; test->name; test++)
        if (is_selected(suite, test, filter_count, filters))
            run_test(suite, test, &own);
    if (own.passed + own.failed + own.skipped == 0)
        return;
    printf("%-16s %4d passed %3d failed %3d skipped %8.2f s\n", suite->name, own.passed, own.failed, own.skipped,
           (double)(clock() - start) / (double)CLOCKS_PER_SEC);
    sum->passed += own.passed;
    sum->failed += own.failed;
    sum->skipped += own.skipped;
}

int main(int argc, char **argv)
{
    totals sum = {0, 0, 0};
    int first = 1, step = 1;
    int shared = argc > 1 && sscanf(argv[1], "%d/%d", &first, &step) == 2 && first > 0 && step > 0;
    if (!shared)
        first = step = 1;
    for (int i = first - 1; i < SUITE_COUNT; i += step)
        run_suite(suites[i], argc - 1 - shared, argv + 1 + shared, &sum);
    if (sum.passed + sum.failed + sum.skipped == 0)
        printf("no test has such a name\n");
    printf("%d passed, %d failed, %d skipped\n", sum.passed, sum.failed, sum.skipped);
    return sum.failed != 0 || sum.passed + sum.failed + sum.skipped == 0;
}
