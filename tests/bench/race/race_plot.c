/* race_plot TIMES MACHINE STEPS SERIES JUMPS FOLDER: what race.sh measured, as tables (race.md) and pictures
 * (race_time.svg, race_phases.svg, race_roofline.svg) in a folder. Lines are those that the racers, race_machine,
 * bench_step and bench_jumps print, "# turn" and "# threads" those of race.sh. Of steps and results that come more than
 * once, the least counts. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "examples/plot.h"

enum { MOST_RESULTS = 2000, MOST_NAMES = 40, MOST_TURNS = 40, SERIES = 5, NAME = 64 };

typedef struct result {
    char system[NAME], solver[NAME];
    int unknowns, threads, iterations;
    double tolerance, setup, solve, residual;
} result;

typedef struct result_list {
    result items[MOST_RESULTS];
    int count;
} result_list;

typedef struct product {
    char system[NAME];
    int threads;
    double ms, bytes, flops;
} product;

typedef struct machine {
    double memory, cache, peak; /* GB/s, GB/s, Gflop/s */
} machine;

typedef struct step {
    char name[NAME];
    int threads, turn;
    double tolerance, iterations;
    double total, phases[5]; /* ms; the last is the rest */
} step;

/* Multigrid on a beam with stiff parts. */
typedef struct jump {
    char mesh[NAME], parts[NAME], state[NAME];
    int unknowns, iterations[2];
    double ratios[2];
} jump;

/* The systems of the series in growing order; they are quadratic beams with nu = 0.45. */
static const char *const series_names[SERIES] = {"series_5k", "series_13k", "beam_tet10_9k", "series_137k",
                                                 "series_310k"};

static result_list race, series;      /* of all racers; of multigrid on the series, the least of all turns */
static result_list turns[MOST_TURNS]; /* and what each turn found */
static int turn_count;
static product products[MOST_RESULTS];
static step steps[MOST_RESULTS], all_steps[MOST_RESULTS]; /* the least of all turns; all */
static jump jumps[MOST_RESULTS];
static machine machines[3]; /* by threads */
static int product_count, step_count, all_step_count, step_turn_count, jump_count, jumps_are_whole;

/* ---- reading ---- */

static FILE *open_or_stop(const char *path, const char *mode)
{
    FILE *file = fopen(path, mode);
    if (!file) {
        fprintf(stderr, "race_plot: %s cannot be opened\n", path);
        exit(1);
    }
    return file;
}

/* hypre's settings take part as one: the best for each system, tolerance and number of threads. */
static int merged_with(const result *a, const result *b)
{
    return strcmp(a->system, b->system) == 0 && strcmp(a->solver, b->solver) == 0 && a->threads == b->threads &&
           a->tolerance == b->tolerance;
}

static void keep_result(result_list *list, result r)
{
    if (!(r.residual < 2 * r.tolerance)) {
        fprintf(stderr, "race_plot: %s of %s to %g left out: residual %g\n", r.solver, r.system, r.tolerance,
                r.residual);
        return;
    }
    if (strncmp(r.solver, "hypre", 5) == 0)
        strcpy(r.solver, "hypre-best");
    for (int k = 0; k < list->count; k++)
        if (merged_with(list->items + k, &r)) {
            if (r.setup + r.solve < list->items[k].setup + list->items[k].solve)
                list->items[k] = r;
            return;
        }
    if (list->count < MOST_RESULTS)
        list->items[list->count++] = r;
}

static int read_result(const char *line, result *r)
{
    return sscanf(line, "race %63s %d %63s %d %lf %lf %lf %d %lf", r->system, &r->unknowns, r->solver, &r->threads,
                  &r->tolerance, &r->setup, &r->solve, &r->iterations, &r->residual) == 9;
}

static void read_times(const char *path)
{
    FILE *file = open_or_stop(path, "r");
    char line[512];
    result r;
    while (fgets(line, sizeof line, file))
        if (read_result(line, &r))
            keep_result(&race, r);
    fclose(file);
}

static void read_series(const char *path)
{
    FILE *file = open_or_stop(path, "r");
    char line[512];
    result r;
    while (fgets(line, sizeof line, file)) {
        turn_count += strcmp(line, "# turn\n") == 0 && turn_count < MOST_TURNS;
        if (!read_result(line, &r))
            continue;
        keep_result(&series, r);
        if (turn_count > 0)
            keep_result(turns + turn_count - 1, r);
    }
    fclose(file);
}

static void read_machine(const char *path)
{
    FILE *file = open_or_stop(path, "r");
    char line[512], what[NAME];
    while (fgets(line, sizeof line, file)) {
        int threads;
        double value;
        product p;
        if (sscanf(line, "machine %63s %d %lf", what, &threads, &value) == 3 && (threads == 1 || threads == 2)) {
            double *place = strcmp(what, "memory") == 0  ? &machines[threads].memory
                            : strcmp(what, "cache") == 0 ? &machines[threads].cache
                                                         : &machines[threads].peak;
            *place = value;
        } else if (sscanf(line, "product %63s %d %lf %lf %lf", p.system, &p.threads, &p.ms, &p.bytes, &p.flops) == 5 &&
                   product_count < MOST_RESULTS) {
            products[product_count++] = p;
        }
    }
    fclose(file);
}

/* The like of a step on some threads in a list; turn 0: in any. */
static step *find_step(step *list, int count, const step *like, int threads, int turn)
{
    for (int k = 0; k < count; k++)
        if (strcmp(list[k].name, like->name) == 0 && list[k].threads == threads &&
            list[k].tolerance == like->tolerance && (turn == 0 || list[k].turn == turn))
            return list + k;
    return NULL;
}

static void keep_step(step s)
{
    step *known = find_step(steps, step_count, &s, s.threads, 0);
    if (known && s.total < known->total)
        *known = s;
    else if (!known && step_count < MOST_RESULTS)
        steps[step_count++] = s;
    if (all_step_count < MOST_RESULTS)
        all_steps[all_step_count++] = s;
}

/* Their medians. */
static void read_steps(const char *path)
{
    FILE *file = open_or_stop(path, "r");
    char line[512];
    int threads = 1;
    while (fgets(line, sizeof line, file)) {
        step s;
        const char *bar = strchr(line, '|');
        step_turn_count += strcmp(line, "# turn\n") == 0;
        if (sscanf(line, "# threads %d", &threads) == 1 || !bar || line[0] == '#' ||
            sscanf(line, "%63s %lf %*d %lf %*f %*f %lf", s.name, &s.tolerance, &s.total, &s.iterations) != 4 ||
            sscanf(bar, "| %lf %lf %lf %lf", s.phases, s.phases + 1, s.phases + 2, s.phases + 3) != 4)
            continue;
        s.threads = threads;
        s.turn = step_turn_count;
        s.phases[4] = fmax(0, s.total - s.phases[0] - s.phases[1] - s.phases[2] - s.phases[3]);
        keep_step(s);
    }
    fclose(file);
}

static void read_jumps(const char *path)
{
    FILE *file = open_or_stop(path, "r");
    char line[512];
    while (fgets(line, sizeof line, file) && jump_count < MOST_RESULTS) {
        jump *j = jumps + jump_count;
        jumps_are_whole |= strncmp(line, "# at most", 9) == 0; /* its last line */
        jump_count += sscanf(line, "%63s %d %63s %63s %d %d %lf %lf", j->mesh, &j->unknowns, j->parts, j->state,
                             j->iterations, j->iterations + 1, j->ratios, j->ratios + 1) == 8;
    }
    fclose(file);
}

/* ---- names in order of appearance ---- */

static int list_names(char (*names)[NAME], int solvers)
{
    int count = 0;
    for (int k = 0; k < race.count; k++) {
        const char *name = solvers ? race.items[k].solver : race.items[k].system;
        int known = 0;
        for (int i = 0; i < count; i++)
            known |= strcmp(names[i], name) == 0;
        if (!known && count < MOST_NAMES)
            strcpy(names[count++], name);
    }
    return count;
}

static const result *find(const result_list *list, const char *system, const char *solver, int threads,
                          double tolerance)
{
    for (int k = 0; k < list->count; k++)
        if (strcmp(list->items[k].system, system) == 0 && strcmp(list->items[k].solver, solver) == 0 &&
            list->items[k].threads == threads && list->items[k].tolerance == tolerance)
            return list->items + k;
    return NULL;
}

/* Those systems of the series that took part. */
static int list_series(const char **names)
{
    int count = 0;
    for (int i = 0; i < SERIES; i++)
        for (int k = 0; k < race.count; k++)
            if (strcmp(race.items[k].system, series_names[i]) == 0) {
                names[count++] = series_names[i];
                break;
            }
    return count;
}

static double microseconds_per_unknown(const result *r) { return 1e3 * (r->setup + r->solve) / r->unknowns; }

/* ---- tables ---- */

/* Least total of our own solvers, or 0. */
static double our_best(const char *system, int threads, double tolerance)
{
    double best = 0;
    for (int k = 0; k < race.count; k++) {
        const result *r = race.items + k;
        double total = r->setup + r->solve;
        if (strcmp(r->system, system) == 0 && strncmp(r->solver, "ours", 4) == 0 && r->threads == threads &&
            r->tolerance == tolerance && (best == 0 || total < best))
            best = total;
    }
    return best;
}

static void write_cell(FILE *file, const result *r)
{
    if (r)
        fprintf(file, " %.1f + %.1f (%d) |", r->setup, r->solve, r->iterations);
    else
        fprintf(file, " |");
}

static void write_system(FILE *file, const char *system, char (*solvers)[NAME], int solver_count)
{
    int unknowns = 0;
    for (int k = 0; k < race.count; k++)
        if (strcmp(race.items[k].system, system) == 0)
            unknowns = race.items[k].unknowns;
    fprintf(file, "\n## %s, %d unknowns\n\n", system, unknowns);
    fprintf(file, "| solver | one core, 1e-2 | 1e-6 | two cores, 1e-2 | 1e-6 | times our best total, two cores, 1e-2 | "
                  "1e-6 |\n|---|---|---|---|---|---|---|\n");
    for (int s = 0; s < solver_count; s++) {
        const result *r[2][2];
        int any = 0;
        for (int threads = 1; threads <= 2; threads++)
            for (int t = 0; t < 2; t++) {
                r[threads - 1][t] = find(&race, system, solvers[s], threads, t ? 1e-6 : 1e-2);
                any |= r[threads - 1][t] != NULL;
            }
        if (!any)
            continue;
        fprintf(file, "| %s |", solvers[s]);
        for (int k = 0; k < 4; k++)
            write_cell(file, r[k / 2][k % 2]);
        for (int t = 0; t < 2; t++) {
            double best = our_best(system, 2, t ? 1e-6 : 1e-2);
            if (r[1][t] && best > 0)
                fprintf(file, " %.1f |", (r[1][t]->setup + r[1][t]->solve) / best);
            else
                fprintf(file, " |");
        }
        fprintf(file, "\n");
    }
}

static void write_growth(FILE *file, char (*solvers)[NAME], int solver_count)
{
    const char *names[SERIES];
    int count = list_series(names);
    fprintf(file, "\n## Growth with size: iterations, and microseconds per unknown (set-up and solve), to 1e-6 on two "
                  "cores\n\n| solver |");
    for (int k = 0; k < count; k++)
        fprintf(file, " %s |", names[k]);
    fprintf(file, "\n|---|");
    for (int k = 0; k < count; k++)
        fprintf(file, "---|");
    for (int s = 0; s < solver_count; s++) {
        fprintf(file, "\n| %s |", solvers[s]);
        for (int k = 0; k < count; k++) {
            const result *r = find(&race, names[k], solvers[s], 2, 1e-6);
            if (r)
                fprintf(file, " %d, %.2f |", r->iterations, microseconds_per_unknown(r));
            else
                fprintf(file, " |");
        }
    }
    fprintf(file, "\n");
}

/* The largest time per unknown over the least; 0 when a system is missing. */
static double spread(const result_list *list, int threads, double tolerance)
{
    double least = 0, most = 0;
    for (int k = 0; k < SERIES; k++) {
        const result *r = find(list, series_names[k], "ours-multigrid", threads, tolerance);
        double t = r ? microseconds_per_unknown(r) : 0;
        if (!r)
            return 0;
        least = k == 0 || t < least ? t : least;
        most = t > most ? t : most;
    }
    return most / least;
}

/* 0: not measured. */
static void write_ratio(FILE *file, double ratio)
{
    if (ratio > 0)
        fprintf(file, " %.2f", ratio);
    else
        fputs(" -", file);
}

static void write_series(FILE *file)
{
    if (turn_count == 0)
        return;
    fprintf(file,
            "\n## ours-multigrid by turns\n\nThe series alone, %d times over the whole race: iterations, and "
            "microseconds per unknown (set-up and solve), the\nleast of all turns; the largest of a row over its "
            "least; and the same of each turn by itself.\n\n| cores, residual |",
            turn_count);
    for (int k = 0; k < SERIES; k++)
        fprintf(file, " %s |", series_names[k]);
    fprintf(file, " largest / least | turns |\n|---|---|---|---|---|---|---|---|\n");
    for (int k = 0; k < 4; k++) {
        int threads = 1 + k / 2;
        double tolerance = k % 2 ? 1e-6 : 1e-2;
        fprintf(file, "| %d, %.0e |", threads, tolerance);
        for (int i = 0; i < SERIES; i++) {
            const result *r = find(&series, series_names[i], "ours-multigrid", threads, tolerance);
            if (r)
                fprintf(file, " %d, %.3f |", r->iterations, microseconds_per_unknown(r));
            else
                fprintf(file, " |");
        }
        write_ratio(file, spread(&series, threads, tolerance));
        fputs(" |", file);
        for (int t = 0; t < turn_count; t++)
            write_ratio(file, spread(turns + t, threads, tolerance));
        fprintf(file, " |\n");
    }
}

static void write_steps(FILE *file)
{
    if (step_count == 0)
        return;
    fprintf(file,
            "\n## Whole steps of moving bodies by turns\n\nMedians in ms (mean iterations) of `bench_step`, the least "
            "of %d turns; what the second core gains by them, and\nby each turn's own.\n\n"
            "| body, residual | one core | two cores | gain | turns |\n|---|---|---|---|---|\n",
            step_turn_count);
    for (int k = 0; k < step_count; k++) {
        const step *one = steps + k, *two = find_step(steps, step_count, one, 2, 0);
        if (one->threads != 1 || !two)
            continue;
        fprintf(file, "| %s, %.0e | %.2f (%.1f) | %.2f (%.1f) | %.2f |", one->name, one->tolerance, one->total,
                one->iterations, two->total, two->iterations, one->total / two->total);
        for (int t = 1; t <= step_turn_count; t++) {
            const step *own = find_step(all_steps, all_step_count, one, 1, t);
            two = find_step(all_steps, all_step_count, one, 2, t);
            write_ratio(file, own && two ? own->total / two->total : 0);
        }
        fputs(" |\n", file);
    }
}

/* That of the beam, size and state of a column, which the even beam starts. */
static const jump *find_jump(const jump *column, const char *parts)
{
    for (const jump *j = column; j < jumps + jump_count; j++)
        if (strcmp(j->parts, parts) == 0 && strcmp(j->mesh, column->mesh) == 0 && j->unknowns == column->unknowns &&
            strcmp(j->state, column->state) == 0)
            return j;
    return NULL;
}

static int starts_column(const jump *j) { return strcmp(j->parts, jumps[0].parts) == 0; }

static void write_jumps(FILE *file)
{
    double most[2] = {0, 0};
    int missing = 0;
    if (jump_count == 0)
        return;
    fprintf(file, "\n## Multigrid where the modulus jumps by 1:1000\n\nIterations to 1e-2 / 1e-6 of beams with stiff "
                  "parts, nu 0.45, multigrid told the moduli, from a zero start\n(`bench_jumps`). Moving: dt 10 ms, "
                  "damped with beta 0.02 s.\n\n| stiff parts |");
    for (int k = 0; k < jump_count; k++)
        if (starts_column(jumps + k))
            fprintf(file, " %s, %d, %s |", jumps[k].mesh, jumps[k].unknowns,
                    strcmp(jumps[k].state, "moving") == 0 ? "moving" : "at rest");
    fprintf(file, "\n|---|");
    for (int k = 0; k < jump_count; k++)
        if (starts_column(jumps + k))
            fprintf(file, "---|");
    for (const jump *row = jumps; row == jumps || (row < jumps + jump_count && !starts_column(row)); row++) {
        fprintf(file, "\n| %s |", row->parts);
        for (int k = 0; k < jump_count; k++) {
            const jump *j = find_jump(jumps + k, row->parts);
            if (!starts_column(jumps + k))
                continue;
            if (j)
                fprintf(file, " %d / %d |", j->iterations[0], j->iterations[1]);
            else
                fputs(" |", file);
            missing += !j;
        }
    }
    for (int k = 0; k < jump_count; k++)
        for (int t = 0; t < 2; t++)
            most[t] = jumps[k].ratios[t] > most[t] ? jumps[k].ratios[t] : most[t];
    if (missing == 0 && jumps_are_whole)
        fprintf(file, "\n\nAt most %.2f and %.2f times those of the even beam.\n", most[0], most[1]);
    else
        fprintf(file, "\n\nNot all were measured.\n");
}

static void write_tables(const char *folder)
{
    static char systems[MOST_NAMES][NAME], solvers[MOST_NAMES][NAME];
    int system_count = list_names(systems, 0), solver_count = list_names(solvers, 1);
    char path[1024];
    FILE *file;
    snprintf(path, sizeof path, "%s/race.md", folder);
    file = open_or_stop(path, "w");
    fprintf(file,
            "# The race\n\nWritten by `make race`; do not edit. Systems of one implicit step of a cantilever under "
            "gravity, from a zero start;\nall racers read the same files. Cells are set-up + solve in ms (iterations), "
            "least times of a few runs, to a relative\nresidual that the harness checks itself. Set-up of CHOLMOD and "
            "of ours-direct is the numeric factorisation alone. hypre:\nthe best of the settings in race_hypre.c for "
            "each cell.\n\nTriad from memory %.1f and %.1f GB/s, from cache %.1f and %.1f GB/s, arithmetic %.1f and "
            "%.1f Gflop/s on one and two\ncores.\n\n![time against unknowns](race_time.svg)\n\n"
            "![share of each phase of a step](race_phases.svg)\n\n![position of the product](race_roofline.svg)\n",
            machines[1].memory, machines[2].memory, machines[1].cache, machines[2].cache, machines[1].peak,
            machines[2].peak);
    for (int k = 0; k < system_count; k++)
        write_system(file, systems[k], solvers, solver_count);
    write_growth(file, solvers, solver_count);
    write_series(file);
    write_steps(file);
    write_jumps(file);
    fclose(file);
}

/* ---- pictures ---- */

static void save(const plot *p, const char *folder, const char *name)
{
    char path[1024];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    if (!plot_save_svg(p, path)) {
        fprintf(stderr, "race_plot: %s cannot be written\n", path);
        exit(1);
    }
}

static void draw_times(const char *folder)
{
    static char solvers[MOST_NAMES][NAME];
    static double x[2][PLOT_CURVES][SERIES], y[2][PLOT_CURVES][SERIES];
    const char *names[SERIES];
    int solver_count = list_names(solvers, 1), count = list_series(names);
    plot p;
    plot_begin(&p, "Quadratic beams, two cores: set-up and solve");
    for (int t = 0; t < 2; t++) {
        plot_panel *panel = plot_add_panel(&p, t ? "to a residual of 1e-6" : "to a residual of 1e-2", "unknowns", "ms");
        panel->log_x = panel->log_y = 1;
        for (int s = 0; s < solver_count && s < PLOT_CURVES; s++) {
            int points = 0;
            for (int k = 0; k < count; k++) {
                const result *r = find(&race, names[k], solvers[s], 2, t ? 1e-6 : 1e-2);
                if (!r)
                    continue;
                x[t][s][points] = r->unknowns;
                y[t][s][points++] = r->setup + r->solve;
            }
            if (points > 0)
                plot_add_curve(panel, solvers[s], x[t][s], y[t][s], points)->markers = 1;
        }
    }
    save(&p, folder, "race_time.svg");
}

static void draw_roofline(const char *folder)
{
    enum { POINTS = 41 };
    static double x[POINTS], roofs[2][2][POINTS], at[MOST_RESULTS][2];
    static const char *const titles[2] = {"one core", "two cores"};
    plot p;
    plot_begin(&p, "The product y = A x under the roofs of the machine");
    for (int i = 0; i < POINTS; i++)
        x[i] = pow(10, -2 + 0.1 * i);
    for (int threads = 1; threads <= 2; threads++) {
        const machine *m = machines + threads;
        plot_panel *panel = plot_add_panel(&p, titles[threads - 1], "flop per byte", "Gflop/s");
        panel->log_x = panel->log_y = 1;
        for (int i = 0; i < POINTS; i++) {
            roofs[threads - 1][0][i] = fmin(m->peak, m->memory * x[i]);
            roofs[threads - 1][1][i] = fmin(m->peak, m->cache * x[i]);
        }
        plot_add_curve(panel, "memory", x, roofs[threads - 1][0], POINTS);
        plot_add_curve(panel, "cache", x, roofs[threads - 1][1], POINTS)->dashed = 1;
        for (int k = 0; k < product_count && panel->curve_count < PLOT_CURVES; k++) {
            const product *q = products + k;
            if (q->threads != threads || strstr(q->system, "_49") || strcmp(q->system, "series_13k") == 0)
                continue; /* a panel has room for eight, and those lie where their likes do */
            at[k][0] = q->flops / q->bytes;
            at[k][1] = 1e-6 * q->flops / q->ms;
            plot_add_curve(panel, q->system, &at[k][0], &at[k][1], 1)->markers = 1;
        }
    }
    save(&p, folder, "race_roofline.svg");
}

static void write_bar(FILE *file, const step *s, double y)
{
    char text[160];
    double x = 240, width = 560;
    snprintf(text, sizeof text, "%.63s, %d core%s", s->name, s->threads, s->threads > 1 ? "s" : "");
    plot_write_label(file, x - 10, y + 14, "text-anchor=\"end\"", text);
    for (int k = 0; k < 5; k++) {
        double share = s->phases[k] / (s->phases[0] + s->phases[1] + s->phases[2] + s->phases[3] + s->phases[4]);
        fprintf(file, "<rect x=\"%.1f\" y=\"%.1f\" width=\"%.1f\" height=\"18\" fill=\"%s\"/>\n", x, y, share * width,
                plot_colour(k));
        x += share * width;
    }
    snprintf(text, sizeof text, "%.2f ms", s->total);
    plot_write_label(file, 812, y + 14, "", text);
}

/* One bar for each workload and number of cores, of steps solved to 1e-2: what a trainer runs. */
static void draw_phases(const char *folder)
{
    static const char *const names[5] = {"forces", "tangent", "preconditioner", "solve", "rest"};
    int height = 80, drawn = 0;
    char path[1024];
    FILE *file;
    for (int k = 0; k < step_count; k++)
        height += steps[k].tolerance == 1e-2 ? 24 : 0;
    snprintf(path, sizeof path, "%s/race_phases.svg", folder);
    file = open_or_stop(path, "wb");
    fprintf(file,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"900\" height=\"%d\" viewBox=\"0 0 900 %d\" "
            "font-family=\"sans-serif\" font-size=\"12\" fill=\"#2c3440\">\n"
            "<rect width=\"100%%\" height=\"100%%\" fill=\"white\"/>\n",
            height, height);
    plot_write_label(file, 20, 24, "font-size=\"17\" font-weight=\"bold\"",
                     "Share of each phase of a whole step, solved to 1e-2");
    for (int k = 0; k < 5; k++) {
        fprintf(file, "<rect x=\"%d\" y=\"38\" width=\"14\" height=\"14\" fill=\"%s\"/>\n", 240 + 115 * k,
                plot_colour(k));
        plot_write_label(file, 260 + 115 * k, 50, "", names[k]);
    }
    for (int k = 0; k < step_count; k++)
        if (steps[k].tolerance == 1e-2)
            write_bar(file, steps + k, 66 + 24 * drawn++);
    fputs("</svg>\n", file);
    fclose(file);
}

int main(int argc, char **argv)
{
    if (argc != 7) {
        fprintf(stderr, "race_plot TIMES MACHINE STEPS SERIES JUMPS FOLDER\n");
        return 1;
    }
    read_times(argv[1]);
    read_machine(argv[2]);
    read_steps(argv[3]);
    read_series(argv[4]);
    read_jumps(argv[5]);
    if (race.count == 0) {
        fprintf(stderr, "race_plot: %s holds no results\n", argv[1]);
        return 1;
    }
    write_tables(argv[6]);
    draw_times(argv[6]);
    draw_phases(argv[6]);
    draw_roofline(argv[6]);
    return 0;
}
