/* Tests that call every public function of softbody.h, needle.h and register.h with absurd arguments, one at a time:
 * NULL, 0, -1, INT_MAX, NaN, infinities, the largest and the smallest number, enums out of range, structs of zeros, and
 * structs with each field in turn so. The calls are generated from the headers, so that a new function is among them
 * (see tests/calls.txt). A call must give a named error, or do nothing sensible, leave its outputs alone when it fails,
 * and what it was given must go on as if it had not been. */
#define _POSIX_C_SOURCE 200809L /* a crash is then a failure like others, outside of sanitizers */
#include <setjmp.h>
#include <signal.h>

#include "hostile.h"

#include "calls.h"

enum { CALL_COUNT = sizeof hostile_calls / sizeof hostile_calls[0], MOST_SECONDS = 60 };

#if defined(__SANITIZE_ADDRESS__)
#define CATCHES 0
#elif defined(__has_feature)
#if __has_feature(address_sanitizer)
#define CATCHES 0
#endif
#endif
#if !defined(CATCHES) && defined(__unix__)
#include <unistd.h>
#define CATCHES 1
#elif !defined(CATCHES)
#define CATCHES 0
#endif

#if CATCHES
static sigjmp_buf back;

static void catch_signal(int number) { siglongjmp(back, number); }

static void catch_crashes(void (*handler)(int))
{
    static const int numbers[] = {SIGSEGV, SIGBUS, SIGFPE, SIGALRM};
    struct sigaction action;
    memset(&action, 0, sizeof action);
    action.sa_handler = handler;
    for (size_t i = 0; i < sizeof numbers / sizeof numbers[0]; i++)
        sigaction(numbers[i], &action, NULL);
}

/* 0 when it crashed or did not come back: then all that it was given is lost. */
static int do_safely(hostile *h, void (*what)(hostile *))
{
    int number;
    alarm(MOST_SECONDS);
    if ((number = sigsetjmp(back, 1)) == 0)
        what(h);
    alarm(0);
    if (number == SIGALRM)
        hostile_complain(h, "did not come back");
    else if (number)
        hostile_complain(h, "crashed");
    return number == 0;
}
#else
static int do_safely(hostile *h, void (*what)(hostile *))
{
    what(h);
    return 1;
}
#endif

static void go_on(hostile *h) { h->hash = world_go_on(&h->things); }

/* One call, then what was left of the world goes on, to `hash` if nothing was changed. */
static void try_call(hostile *h, const hostile_call *call, unsigned long long hash)
{
    int failed;
    world_begin(&h->things);
    if (!do_safely(h, call->call)) {
        memset(h->arguments, 0, sizeof h->arguments);
        return;
    }
    failed = call->returns_result && h->result != SB_OK;
    if (failed)
        hostile_check_untouched(h);
    if (call->returns_result && h->slot >= 0 && h->must_fail && !failed && !hostile_is_listed(h, hostile_accepted))
        hostile_complain(h, "gave SB_OK");
    if (!do_safely(h, go_on)) {
        memset(h->arguments, 0, sizeof h->arguments);
        return;
    }
    if (((failed && call->changes < 2) || !call->changes) && hash != h->hash)
        hostile_complain(h, "what it was given does not go on as without the call");
    if (!do_safely(h, hostile_release))
        memset(h->arguments, 0, sizeof h->arguments);
}

/* All replacements of all arguments of one function. */
static void try_function(const hostile_call *call, int stride)
{
    static hostile h;
    unsigned long long hash;
    int values[HOSTILE_ARGUMENTS] = {0};
    memset(&h, 0, sizeof h);
    h.function = call->name;
    h.returns_result = call->returns_result;
    h.trusted = hostile_trusted;
    h.slot = -1;
    h.error_slot = -1;
    world_begin(&h.things);
    h.dry = 1;
    if (!do_safely(&h, call->call) || !do_safely(&h, go_on))
        return;
    hash = h.hash;
    for (int i = 0; i < HOSTILE_ARGUMENTS; i++)
        values[i] = h.arguments[i].values, h.kinds[i] = h.arguments[i].kind, h.names[i] = h.arguments[i].name;
    hostile_release(&h);
    h.dry = 0;
    try_call(&h, call, hash);
    for (h.slot = 0; h.slot < HOSTILE_ARGUMENTS; h.slot++)
        for (h.value = h.slot % stride; h.value < values[h.slot]; h.value += stride)
            try_call(&h, call, hash);
}

static void try_product(const char *prefix)
{
    int tried = 0;
#if CATCHES
    catch_crashes(catch_signal);
#endif
    for (int i = 0; i < CALL_COUNT; i++)
        if (strncmp(hostile_calls[i].name, prefix, strlen(prefix)) == 0) {
            if (getenv("HOSTILE") && strcmp(getenv("HOSTILE"), hostile_calls[i].name) != 0)
                continue;
            tried++;
            try_function(hostile_calls + i, 1);
        }
#if CATCHES
    catch_crashes(SIG_DFL);
#endif
    CHECK(tried > 0);
}

static void test_softbody(void) { try_product("sb_"); }
static void test_needle(void) { try_product("ndl_"); }
static void test_register(void) { try_product("reg_"); }

CHECK_SUITE(hostile, {"softbody.h", test_softbody}, {"needle.h", test_needle}, {"register.h", test_register});
