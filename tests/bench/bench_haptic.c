/* bench_haptic: the call at 1 kHz, by itself.
 *
 *     haptic_force          eight clusters in contact and slipping, the default coupling, turns too
 *     haptic_force_rigid    the same without coupling
 *     haptic_force_plane    one cluster, the default coupling, no torques: the usual device
 *
 * A hand that strokes, and every tenth call a new frame. One line per workload:
 *     name calls median_us p99_us p99.9_us p99.99_us checksum
 * of single calls, less what reading the clock takes; the checksum is the sum of the forces' sizes. All calls are made
 * ROUNDS times over, the same each time to the last bit, and beside each call a loop is timed that does the same number
 * of dependent additions each time: about as long as such a call takes, with a frame or without. Then:
 *     the least        of each call over the rounds: what the call takes itself
 *     constant work    of the loops of the last round: what it has beyond its median is the machine's
 *     beyond 5 us      how many of the last round, with a frame and without, of which are so by themselves: by the
 * least Asserts nothing. */
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "measure.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { CALLS = 1000000, FRAMES = 10 /* calls from one to the next */, ROUNDS = 5 };

static volatile double keep;

/* Wall time (s) since the first call: now() has too few digits for what takes less than a microsecond. */
static double instant(void)
{
    static struct timespec first;
    struct timespec t;
    timespec_get(&t, TIME_UTC);
    if (first.tv_sec == 0)
        first = t;
    return (double)(t.tv_sec - first.tv_sec) + 1e-9 * (double)(t.tv_nsec - first.tv_nsec);
}

/* Planes like a dent's, pressed with about half a newton each. */
static sbi_haptic_frame dent(int count, double time)
{
    sbi_haptic_frame frame;
    memset(&frame, 0, sizeof frame);
    frame.pose.rotation.w = 1;
    frame.count = count;
    for (int c = 0; c < count; c++) {
        sbi_haptic_cluster *k = frame.clusters + c;
        double angle = 6.283185307179586 * c / count;
        k->point = sbi_d(0.005 * cos(angle), 0.005 * sin(angle), -0.008);
        k->normal = sbi_d(-0.6 * cos(angle), -0.6 * sin(angle), 0.8);
        k->push = 0.5 + 0.1 * sin(3 * time + c);
        k->traction = sbi_d(0.08 * sin(angle), -0.08 * cos(angle), 0);
        k->torque = sbi_d(1e-4, 0, 0);
        k->friction = 0.3;
        k->stiffness = 200;
        k->tangential = 100;
    }
    return frame;
}

/* What keeps the processor for `count` additions, one after the other. */
static double work(int count)
{
    volatile double one = 1e-9; /* so that the sum is not known beforehand */
    const double step = one;
    double sum = 0;
    for (int i = 0; i < count; i++)
        sum += step;
    return sum;
}

/* Additions that take as long as this (s). */
static int work_of(double length)
{
    enum { MANY = 100000, TRIES = 21 };
    double times[TRIES];
    for (int i = 0; i < TRIES; i++) {
        double begun = instant();
        keep = work(MANY);
        times[i] = instant() - begun;
    }
    qsort(times, TRIES, sizeof times[0], ascending);
    return (int)(length / times[0] * (double)MANY) + 1;
}

/* Median of the calls with a frame, or of those without. */
static double median_of(const double *values, int with_frame)
{
    static double some[CALLS];
    int count = 0;
    for (int i = 0; i < CALLS; i++)
        if ((i % FRAMES == 0) == with_frame)
            some[count++] = values[i];
    return median(some, count);
}

static void tell_long(const char *name, const double *values)
{
    const double most = 5e-6; /* s */
    int with = 0, without = 0;
    for (int i = 0; i < CALLS; i++) {
        with += i % FRAMES == 0 && values[i] > most;
        without += i % FRAMES != 0 && values[i] > most;
    }
    printf("  beyond 5 us, %-18s %d of %d with a frame, %d of %d without\n", name, with, (int)CALLS / FRAMES, without,
           (int)(CALLS - CALLS / FRAMES));
}

static void tell(const char *name, double *values, double sum)
{
    qsort(values, CALLS, sizeof values[0], ascending);
    printf("%-22s %d %.3f %.3f %.3f %.3f %.9g\n", name, (int)CALLS, 1e6 * values[CALLS / 2],
           1e6 * values[CALLS / 100 * 99], 1e6 * values[CALLS / 1000 * 999], 1e6 * values[CALLS / 10000 * 9999], sum);
}

static double clock_takes(void)
{
    static double times[CALLS];
    for (int i = 0; i < CALLS; i++) {
        double t = instant();
        times[i] = instant() - t;
    }
    return median(times, CALLS);
}

/* All calls once: times [CALLS] (s), and beside each of them work of as many additions: additions [2] without a frame
 * and with, controls [CALLS] (s). Returns the checksum. */
static double call_all(sbi_servo *servo, int clusters, const int *additions, double *times, double *controls)
{
    const double clock = clock_takes();
    double sum = 0;
    for (int i = 0; i < CALLS; i++) {
        double time = 1e-3 * i, begun;
        sbi_haptic_frame frame = dent(clusters, time);
        sb_tool_state state;
        sb_wrench_d out;
        memset(&state, 0, sizeof state);
        state.position[0] = 0.002 * sin(4 * time);
        state.position[2] = -0.0005 + 0.0007 * sin(2.3 * time);
        state.rotation[0] = state.rotation[4] = state.rotation[8] = 1;
        state.time = time;
        begun = instant();
        sbi_servo_call(servo, &state, i % FRAMES ? NULL : &frame, &out);
        times[i] = instant() - begun - clock;
        begun = instant();
        keep = work(additions[i % FRAMES == 0]);
        controls[i] = instant() - begun - clock;
        sum += sqrt(out.force[0] * out.force[0] + out.force[1] * out.force[1] + out.force[2] * out.force[2]);
    }
    return sum;
}

static void run(const char *name, int clusters, double max_torque, double coupling)
{
    static double times[CALLS], least[CALLS], controls[CALLS];
    int additions[2] = {1, 1};
    sb_haptic_def def = sb_default_haptic_def();
    double sum = 0;
    def.max_force = 8;
    def.max_torque = max_torque;
    def.max_stiffness = 2000;
    def.max_damping = 3;
    def.coupling = coupling;
    def.resolution = 5.5e-5;
    for (int round = 0; round < ROUNDS; round++) {
        sbi_servo servo;
        if (sbi_servo_begin(&servo, &def, NULL) != SB_OK)
            return;
        sum = call_all(&servo, clusters, additions, times, controls);
        for (int i = 0; i < CALLS; i++)
            least[i] = round > 0 && least[i] < times[i] ? least[i] : times[i];
        for (int with_frame = 0; with_frame < 2; with_frame++)
            additions[with_frame] = work_of(median_of(least, with_frame));
    }
    tell_long("the calls:", times);
    tell_long("by themselves:", least);
    tell_long("constant work:", controls);
    tell(name, times, sum);
    tell("  the least", least, sum);
    tell("  constant work", controls, 0);
}

int main(void)
{
    run("haptic_force", 8, 0.4, -1);
    run("haptic_force_rigid", 8, 0.4, 0);
    run("haptic_force_plane", 1, 0, -1);
    return 0;
}
