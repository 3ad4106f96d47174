/* haptic_loop: a hand feels a slab of tissue at 1 kHz, while the tissue is stepped at 100 Hz.
 *
 *     haptic_loop [OPTIONS]      haptic_loop --help lists them
 *
 * There is no device: a simulated hand (a mass with damping, drawn by a spring to where it wants to go, with a tremor
 * and an encoder of coarse steps) feels a sphere that goes into the tissue, rests, slides and comes out. Its loop runs
 * in a thread of its own, as a device's would; where there are no threads, or with --turns, by turns in simulated time.
 * With --hold it is given the force of the last step until the next, which makes it swing.
 * Written are a chart (SVG) and the numbers (CSV). Exit status: 0, 2 wrong usage or a file that cannot be written, 3 a
 * step failed or memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "haptic_slab.h"
#include "options.h"
#include "plot.h"

#if defined(_POSIX_THREADS) && _POSIX_THREADS > 0
#include <pthread.h>
#define HAS_THREADS 1
#else
#define HAS_THREADS 0
#endif

enum { EXIT_USAGE = 2, EXIT_SOLVE = 3, RATE = 1000 /* calls a second */, CHART_STRIDE = 4, MOST_SECONDS = 600 };

static const double tick = 1.0 / (double)RATE, pi = 3.14159265358979; /* s */

typedef struct settings {
    double seconds, steps; /* s; steps a second */
    double young, depth;   /* Pa, m */
    double damping;        /* N s/m of the hand */
    const char *out;       /* NAME.svg and NAME.csv */
    int hold, turns, help;
} settings;

/* The hand and what it felt, by calls. It belongs to the thread that calls. */
typedef struct hand {
    const settings *set;
    sb_haptic *haptic;
    double x[3], v[3], force[3];
    double held[3]; /* N, of the last step: with --hold */
    double given, taken;
    int count;
    double *time, *felt, *depth, *cost; /* [most calls] s, N along z, mm, us */
} hand;

/* The tissue and its tool. */
typedef struct scene {
    slab tissue;
    int steps, refused;
    double *time, *push; /* [most steps] s, N: what the tool feels along z at the end of each */
} scene;

static int complain(const char *what, const sb_error *error)
{
    fprintf(stderr, "haptic_loop: %s: %s\n", what, error->message);
    return EXIT_SOLVE;
}

/* ---- the tissue ------------------------------------------------------------------------------------------------ */

/* What a small desktop device can do. */
static sb_haptic_def device(void)
{
    sb_haptic_def def = sb_default_haptic_def();
    def.max_force = 8;
    def.max_stiffness = 2000;
    def.max_damping = 5;
    def.resolution = 5.5e-5;
    return def;
}

static void free_scene(scene *c)
{
    slab_free(&c->tissue);
    free(c->time);
    free(c->push);
}

/* One step; by --hold the tool is simply where the hand is. */
static int step(const settings *s, scene *c, hand *h, double now)
{
    sb_step_info info;
    sb_result result;
    sb_wrench wrench;
    sb_pose pose = sb_default_tool_def().pose;
    pose.position = sb_v3(h->x[0], h->x[1], h->x[2]);
    if (s->hold)
        sb_contact_move_tool(c->tissue.contact, c->tissue.tool, &pose);
    else
        sb_haptic_take(c->tissue.haptic, NULL);
    result = sb_body_step(c->tissue.body, 1 / s->steps, &info);
    c->refused += s->hold && result == SB_ERROR_DIVERGED; /* the hand has torn through: the tissue stays as it was */
    if (result != SB_OK && !(s->hold && result == SB_ERROR_DIVERGED))
        return complain("step", &info.error);
    sb_contact_wrench(c->tissue.contact, c->tissue.tool, &wrench);
    c->time[c->steps] = now;
    c->push[c->steps++] = wrench.force.z;
    return 0;
}

/* ---- the hand -------------------------------------------------------------------------------------------------- */

/* Where the hand wants to be: above, in, at rest there, to and fro, out again. */
static void wish(const settings *s, double time, double goal[3])
{
    double part = 10 * time / s->seconds, in = part < 1 ? 0 : part < 2 ? part - 1 : part < 8 ? 1 : 9 - part;
    goal[0] = part > 5 && part < 8 ? 0.01 * sin(2 * pi * (part - 5)) : 0;
    goal[1] = 0;
    goal[2] = 0.002 - (s->depth + 0.002) * fmax(in, 0) + 5e-5 * sin(2 * pi * 9 * time);
}

/* A tick under the force that the device holds. */
static void move(hand *h)
{
    enum { PARTS = 4 };
    const double mass = 0.35, stiffness = 300, dt = tick / (double)PARTS; /* kg, N/m, s */
    double goal[3], work = 0;
    wish(h->set, h->count * tick, goal);
    for (int k = 0; k < 3 * PARTS; k++) {
        int i = k % 3;
        double pull = h->force[i] + stiffness * (goal[i] - h->x[i]);
        h->v[i] = (h->v[i] + dt / mass * pull) / (1 + dt * h->set->damping / mass);
        h->x[i] += dt * h->v[i];
        work += h->force[i] * dt * h->v[i];
    }
    h->given += fmax(work, 0);
    h->taken += fmax(-work, 0);
}

/* A call: what the encoder says goes in, a force comes out. */
static void feel(hand *h)
{
    const double resolution = device().resolution;
    sb_tool_state in = sb_haptic_from_hd(NULL, NULL);
    sb_wrench_d out;
    double begun;
    move(h);
    for (int i = 0; i < 3; i++)
        in.position[i] = resolution * floor(h->x[i] / resolution + 0.5);
    in.time = h->count * tick;
    begun = seconds_now();
    sb_haptic_force(h->haptic, &in, &out);
    h->cost[h->count] = 1e6 * (seconds_now() - begun);
    for (int i = 0; i < 3; i++)
        h->force[i] = h->set->hold ? h->held[i] : out.force[i];
    h->time[h->count] = in.time;
    h->felt[h->count] = h->force[2];
    h->depth[h->count++] = -1e3 * h->x[2];
}

static int calls(const settings *s) { return (int)(s->seconds * (double)RATE); }

/* ---- the two loops --------------------------------------------------------------------------------------------- */

static void hold(hand *h, const scene *c)
{
    sb_wrench wrench;
    double most = device().max_force, share;
    sb_contact_wrench(c->tissue.contact, c->tissue.tool, &wrench);
    share = fmin(1, most / fmax(most, sb_v3_norm(wrench.force))); /* what the device can give */
    wrench.force = sb_v3_scale(share, wrench.force);
    h->held[0] = wrench.force.x;
    h->held[1] = wrench.force.y;
    h->held[2] = wrench.force.z;
}

/* Both in one thread and in simulated time: what a step computes arrives when the next one begins. */
static int run_by_turns(const settings *s, scene *c, hand *h)
{
    int status = 0;
    while (h->count < calls(s) && !status) {
        double now = h->count * tick;
        if (now >= c->steps / s->steps) {
            if (s->hold && c->steps > 0)
                hold(h, c);
            else if (c->steps > 0)
                sb_haptic_publish(c->tissue.haptic);
            status = step(s, c, h, now);
        }
        feel(h);
    }
    return status;
}

#if HAS_THREADS
static void sleep_until(double when)
{
    double rest = when - seconds_now();
    struct timespec time;
    if (!(rest > 0))
        return;
    time.tv_sec = (time_t)rest;
    time.tv_nsec = (long)(1e9 * (rest - (double)time.tv_sec));
    nanosleep(&time, NULL);
}

static void *serve(void *user)
{
    hand *h = (hand *)user;
    double begun = seconds_now();
    while (h->count < calls(h->set)) {
        sleep_until(begun + h->count * tick);
        feel(h);
    }
    return NULL;
}

static int run_threads(const settings *s, scene *c, hand *h)
{
    double begun = seconds_now(), now = 0;
    pthread_t thread;
    int status = 0;
    if (pthread_create(&thread, NULL, serve, h) != 0) {
        fprintf(stderr, "haptic_loop: there is no thread for the hand; --turns does without\n");
        return EXIT_SOLVE;
    }
    while (now < s->seconds && !status) {
        hand nobody; /* the hand's own place belongs to its thread */
        memset(&nobody, 0, sizeof nobody);
        status = step(s, c, &nobody, now);
        sb_haptic_publish(c->tissue.haptic);
        sleep_until(begun + c->steps / s->steps);
        now = seconds_now() - begun;
    }
    pthread_join(thread, NULL);
    return status;
}
#else
static int run_threads(const settings *s, scene *c, hand *h) { return run_by_turns(s, c, h); }
#endif

/* ---- what came of it ------------------------------------------------------------------------------------------- */

static int compare(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Range of the hand's depth while it is to rest (mm). */
static double swing(const settings *s, const hand *h)
{
    int from = (int)(0.35 * calls(s)), to = (int)(0.5 * calls(s));
    double low = h->depth[from], high = low;
    for (int i = from; i < to; i++) {
        low = fmin(low, h->depth[i]);
        high = fmax(high, h->depth[i]);
    }
    return high - low;
}

static void report(const settings *s, const scene *c, const hand *h)
{
    double peak = 0, square = 0, jump = 0;
    for (int i = 1; i < h->count; i++) {
        peak = fmax(peak, fabs(h->felt[i]));
        jump = fmax(jump, fabs(h->felt[i] - h->felt[i - 1]));
    }
    for (int i = 0; i < c->steps; i++) {
        int call = (int)(c->time[i] * (double)RATE);
        double off = c->push[i] - h->felt[call < h->count ? call : h->count - 1];
        square += off * off;
    }
    qsort(h->cost, (size_t)h->count, sizeof *h->cost, compare);
    printf("force      up to %.2f N, changes by %.1f %% of it within 1 ms at most\n", peak, 100 * jump / peak);
    printf("error      %.1f %% of it (rms), against the tool's force at the end of each of %d steps\n",
           100 * sqrt(square / c->steps) / peak, c->steps);
    printf("swing      %.3f mm while the hand is to rest\n", swing(s, h));
    printf("energy     %.3f mJ taken from the hand, %.3f mJ given to it\n", 1e3 * h->taken, 1e3 * h->given);
    if (c->refused)
        printf("refused    %d steps, in which the hand tore through\n", c->refused);
    if (!s->hold)
        printf("call       median %.2f us, p99.9 %.2f us\n", h->cost[h->count / 2], h->cost[(int)(0.999 * h->count)]);
}

static int write_numbers(const hand *h, const char *path)
{
    sb_output out;
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return 0;
    fprintf(out.file, "time (s),force (N),depth (mm)\n");
    for (int i = 0; i < h->count; i++)
        fprintf(out.file, "%.3f,%.6g,%.6g\n", h->time[i], h->felt[i], h->depth[i]);
    return sb_output_close(&out, NULL) == SB_OK;
}

/* Keeps each fourth of some numbers, in place: a chart does not show more. */
static int thin(double *values, int count)
{
    int kept = 0;
    for (int i = 0; i < count; i += CHART_STRIDE)
        values[kept++] = values[i];
    return kept;
}

static int write_all(const settings *s, const scene *c, hand *h)
{
    char chart[1024], numbers[1024];
    plot p;
    plot_panel *panel;
    int count;
    if (snprintf(chart, sizeof chart, "%s.svg", s->out) >= (int)sizeof chart ||
        snprintf(numbers, sizeof numbers, "%s.csv", s->out) >= (int)sizeof numbers) {
        fprintf(stderr, "haptic_loop: %s is too long a name\n", s->out);
        return EXIT_USAGE;
    }
    if (!write_numbers(h, numbers)) {
        fprintf(stderr, "haptic_loop: %s cannot be written\n", numbers);
        return EXIT_USAGE;
    }
    count = thin(h->time, h->count);
    thin(h->felt, h->count);
    thin(h->depth, h->count);
    plot_begin(&p, s->hold ? "A hand that is given each step's force" : "A hand that feels tissue at 1 kHz");
    panel = plot_add_panel(&p, "Force", "time (s)", "force (N)");
    plot_add_curve(panel, "on the hand", h->time, h->felt, count);
    plot_add_curve(panel, "of the steps", c->time, c->push, c->steps)->dashed = 1;
    panel = plot_add_panel(&p, "Hand", "time (s)", "depth (mm)");
    plot_add_curve(panel, "hand", h->time, h->depth, count);
    if (!plot_save_svg(&p, chart)) {
        fprintf(stderr, "haptic_loop: %s cannot be written\n", chart);
        return EXIT_USAGE;
    }
    printf("written    %s, %s\n", chart, numbers);
    return 0;
}

/* ---- main ------------------------------------------------------------------------------------------------------ */

static int run(const settings *s, scene *c, hand *h)
{
    const sb_haptic_def def = device();
    sb_error error;
    int status;
    if (slab_make(&c->tissue, s->young, 2, &def, &error) != SB_OK)
        return complain("tissue", &error);
    h->set = s;
    h->haptic = c->tissue.haptic;
    h->x[2] = 0.002;
    status = s->turns ? run_by_turns(s, c, h) : run_threads(s, c, h);
    if (status)
        return status;
    report(s, c, h);
    return write_all(s, c, h);
}

/* All memory, then all of it again. */
static int take_and_run(const settings *s)
{
    size_t most = (size_t)calls(s) + 1, steps = (size_t)(s->seconds * s->steps) + 2;
    double *log = (double *)calloc(most, 4 * sizeof(double));
    scene c = {{NULL, NULL, NULL, 0}, 0, 0, NULL, NULL};
    hand h;
    int status = EXIT_SOLVE;
    memset(&h, 0, sizeof h);
    c.time = (double *)calloc(steps, sizeof(double));
    c.push = (double *)calloc(steps, sizeof(double));
    if (log && c.time && c.push) {
        h.time = log;
        h.felt = log + most;
        h.depth = log + 2 * most;
        h.cost = log + 3 * most;
        status = run(s, &c, &h);
    } else {
        fprintf(stderr, "haptic_loop: memory is short\n");
    }
    free_scene(&c);
    free(log);
    return status;
}

static int program(int argc, char **argv)
{
    settings s = {10, 100, 2e4, 0.004, 1, "haptic_loop", 0, 0, 0};
    const option options[] = {
        {"--seconds", "S", OPTION_NUMBER, NULL, &s.seconds, NULL, 0.5, MOST_SECONDS, "how long it takes"},
        {"--steps", "HZ", OPTION_NUMBER, NULL, &s.steps, NULL, 20, 500, "steps a second"},
        {"--young", "PA", OPTION_NUMBER, NULL, &s.young, NULL, 500, 1e6, "stiffness of the tissue"},
        {"--depth", "M", OPTION_NUMBER, NULL, &s.depth, NULL, 0.001, 0.01, "how deep the hand wants to go"},
        {"--damping", "NS/M", OPTION_NUMBER, NULL, &s.damping, NULL, 0, 100, "of the hand"},
        {"--hold", NULL, OPTION_FLAG, &s.hold, NULL, NULL, 0, 0, "each step's force until the next; by turns"},
        {"--turns", NULL, OPTION_FLAG, &s.turns, NULL, NULL, 0, 0, "no thread: by turns, in simulated time"},
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &s.out, 0, 0, "writes NAME.svg and NAME.csv"},
        {"--help", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, "this text"},
    };
    enum { OPTIONS = sizeof options / sizeof *options };
    if (!options_parse("haptic_loop", options, OPTIONS, NULL, 0, argc, argv))
        return EXIT_USAGE;
    if (s.help) {
        printf("usage: haptic_loop [OPTIONS]\nA simulated hand feels tissue at 1 kHz.\n\n");
        options_print(options, OPTIONS);
        return 0;
    }
    s.turns |= s.hold;
    return take_and_run(&s);
}

int main(int argc, char **argv) { return finish("haptic_loop", program(argc, argv), EXIT_USAGE); }
