/* soak_haptic: hands on the call at 1 kHz for a simulated day.
 *
 *     soak_haptic        SOAK_HOURS=24 for each row, or SOAK_SECONDS=5 of the processor for all rows together,
 *                        SOAK_SEED=2026 for other hands: a day may be run as hours of several seeds
 *
 * Random hands, tissues that stiffen, creep, slide and breathe, steps at 60 and 100 Hz with jitter and stalls to 0.3 s,
 * calls from 0.5 to 2.5 ms apart (tests/haptic_hand.h). What a hand was given beyond the bank must stay below 10 mJ,
 * the force finite and within the device's limits. A row whose force is held between steps shows what the planes are
 * for: it is not checked. Ends with `N passed, N failed, N skipped`. */
#define SB_STATIC
#define SB_ELEMENT SB_TET4
#define SB_NO_FILES
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "check.h"
#include "haptic_hand.h"

#include <time.h>

check_state check;

typedef struct soak_row {
    const char *name;
    double tissue, rate; /* N/m, Hz */
    double coupling;     /* N/m; < 0: the default */
    double breathing;    /* m */
    int rests;           /* 1: the hand rests on one spot with its tremor */
    int held;            /* 1: not checked */
} soak_row;

static const soak_row rows[] = {
    {"400 N/m, 100 Hz", 400, 100, -1, 0, 0, 0},
    {"1,000 N/m, 60 Hz", 1000, 60, -1, 0, 0, 0},
    {"5,000 N/m, 60 Hz", 5000, 60, -1, 0, 0, 0},
    {"400 N/m, 100 Hz, rigid", 400, 100, 0, 0, 0, 0},
    {"400 N/m, 100 Hz, breathing", 400, 100, -1, 2e-3, 0, 0},
    {"20,000 N/m, 60 Hz, at rest", 20000, 60, -1, 0, 1, 0},
    {"400 N/m, 100 Hz, held", 400, 100, 0, 0, 0, 1},
};
enum { ROWS = sizeof rows / sizeof rows[0] };

static int soak_begin(hand_scene *s, const soak_row *row, unsigned long long seed)
{
    sb_haptic_def def = sb_default_haptic_def();
    hand_case is = hand_usual();
    def.max_force = 8;
    def.max_stiffness = 2000;
    def.max_damping = 3;
    def.coupling = row->coupling;
    def.resolution = is.encoder;
    is.tissue = row->tissue;
    is.period = 1 / row->rate;
    is.breathing = row->breathing;
    is.held = row->held;
    is.jitter = 0.5;
    is.tick_low = 5e-4;
    is.tick_high = 2.5e-3;
    if (row->rests)
        is.wander = 0;
    else
        is.stalls = 0.002;
    return hand_begin(s, &is, &def, seed);
}

static void soak_tell(const soak_row *row, const hand_scene *s, double spent)
{
    printf("%-28s %8.2f h %11ld calls, in %10.3f J, out %10.3f J, beyond the bank %7.3f mJ, limited %6.3f %% %7.1f s\n",
           row->name, s->time / 3600, s->calls, s->taken, s->given, 1e3 * s->beyond,
           100.0 * (double)s->servo.info.limited / (double)s->calls, spent);
    fflush(stdout);
}

static int soak_row_run(const soak_row *row, unsigned long long seed, double hours, double seconds)
{
    static hand_scene s;
    clock_t start = clock();
    double spent = 0;
    long told = 0;
    check.failures = 0;
    check.test = row->name;
    if (!soak_begin(&s, row, seed))
        return 0;
    while (seconds > 0 ? spent < seconds : s.time < 3600 * hours) {
        for (int i = 0; i < 1000; i++) {
            hand_call(&s);
            if (!(sbi_d_norm(sbi_d_from(s.force.force)) <= s.servo.def.max_force * (1 + 1e-12)))
                check_near(sbi_d_norm(sbi_d_from(s.force.force)), 0, s.servo.def.max_force, "force", __FILE__,
                           __LINE__);
        }
        spent = (double)(clock() - start) / (double)CLOCKS_PER_SEC;
        if (s.time / (4 * 3600) >= (double)(told + 1)) {
            told++;
            soak_tell(row, &s, spent);
        }
    }
    soak_tell(row, &s, spent);
    CHECK(row->held || s.beyond < 0.01);
    return check.failures == 0;
}

int main(void)
{
    const char *hours = getenv("SOAK_HOURS"), *seconds = getenv("SOAK_SECONDS"), *seed = getenv("SOAK_SEED");
    int passed = 0;
    for (int i = 0; i < ROWS; i++)
        passed += soak_row_run(rows + i, seed && *seed ? strtoull(seed, NULL, 10) : 2026,
                               hours && *hours ? strtod(hours, NULL) : 24,
                               seconds && *seconds ? strtod(seconds, NULL) / (double)ROWS : 0);
    printf("%d passed, %d failed, 0 skipped\n", passed, ROWS - passed);
    return passed != ROWS;
}
