/* check.h: the tiny test harness. A test is a function; a suite is a table of tests at the end of its file.
 * Checks that fail print file, line and values and let the test go on. Only main.c defines CHECK_MAIN. */
#ifndef CHECK_H
#define CHECK_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct check_case {
    const char *name;
    void (*run)(void);
} check_case;

typedef struct check_suite {
    const char *name;
    const check_case *cases; /* ends with a case without a name */
} check_suite;

/* Counts of the running test; main.c owns them. */
typedef struct check_state {
    int failures;
    int skips;
    const char *test;
} check_state;
extern check_state check;

/* Declares the suite NAME with its tests: CHECK_SUITE(dense, {"inverse times matrix", test_inverse}, ...) */
#define CHECK_SUITE(name, ...)                                                                                         \
    static const check_case check_cases_##name[] = {__VA_ARGS__, {NULL, NULL}};                                        \
    extern const check_suite check_suite_##name;                                                                       \
    const check_suite check_suite_##name = {#name, check_cases_##name}

#define CHECK(condition) check_that((condition) != 0, #condition, __FILE__, __LINE__)
/* |actual - expected| <= tolerance; false for NaN. */
#define CHECK_NEAR(actual, expected, tolerance)                                                                        \
    check_near((double)(actual), (double)(expected), (double)(tolerance), #actual, __FILE__, __LINE__)
#define CHECK_INT(actual, expected) check_int((long long)(actual), (long long)(expected), #actual, __FILE__, __LINE__)
/* Checks a call that returns sb_result. */
#define CHECK_RESULT(call, expected) check_result((int)(call), (int)(expected), #call, __FILE__, __LINE__)
#define CHECK_OK(call) CHECK_RESULT(call, 0)
/* Counts a skip (missing data, missing tool) and says why. */
#define CHECK_SKIP(reason) check_skip(reason)

/* Whether long loops should be cut short: with CHECK_QUICK in the environment, for slow builds. */
static inline int check_quick(void) { return getenv("CHECK_QUICK") != NULL; }
/* Rounds of a long random loop: `count`, or a fifth of it with CHECK_SHORT in the environment: for make test, and for
 * builds that look for other things than one more random case. */
static inline int check_rounds(int count) { return getenv("CHECK_SHORT") ? (count + 4) / 5 : count; }

/* From here on the test hands over what is not finite, or makes a call fail by numbers beyond all range: under
 * CHECK_TRAPS (main.c) exceptions are masked for the rest of it. What such input raises on its way to its error is not
 * promised. */
void check_bad_numbers(void);

static inline int check_that(int ok, const char *text, const char *file, int line)
{
    if (!ok) {
        check.failures++;
        printf("%s:%d: [%s] CHECK(%s)\n", file, line, check.test, text);
    }
    return ok;
}

static inline int check_near(double actual, double expected, double tolerance, const char *text, const char *file,
                             int line)
{
    int ok = fabs(actual - expected) <= tolerance;
    if (!ok) {
        check.failures++;
        printf("%s:%d: [%s] %s is %.17g, expected %.17g +- %.3g\n", file, line, check.test, text, actual, expected,
               tolerance);
    }
    return ok;
}

static inline int check_int(long long actual, long long expected, const char *text, const char *file, int line)
{
    if (actual != expected) {
        check.failures++;
        printf("%s:%d: [%s] %s is %lld, expected %lld\n", file, line, check.test, text, actual, expected);
    }
    return actual == expected;
}

static inline int check_result(int actual, int expected, const char *text, const char *file, int line)
{
    if (actual != expected) {
        check.failures++;
        printf("%s:%d: [%s] %s gave %d, expected %d\n", file, line, check.test, text, actual, expected);
    }
    return actual == expected;
}

static inline void check_skip(const char *reason)
{
    check.skips++;
    printf("skip: [%s] %s\n", check.test, reason);
}

/* Random numbers that are the same everywhere (xorshift64*). */
static inline double check_random(unsigned long long *state)
{
    unsigned long long x = *state;
    x ^= x >> 12;
    x ^= x << 25;
    x ^= x >> 27;
    *state = x;
    return (double)((x * 2685821657736338717ULL) >> 11) / 9007199254740992.0;
}
static inline double check_random_in(unsigned long long *state, double low, double high)
{
    return low + (high - low) * check_random(state);
}

/* Path of `name` under the shared folder (environment variable SHARED, else ../shared), in a caller's buffer;
 * 1 when the file exists. */
static inline int check_shared_path(char *path, size_t size, const char *name)
{
    const char *root = getenv("SHARED");
    FILE *file;
    snprintf(path, size, "%s/%s", root ? root : "../shared", name);
    file = fopen(path, "rb");
    if (file)
        fclose(file);
    return file != NULL;
}

#endif /* CHECK_H */
