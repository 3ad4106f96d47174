/* needle_control: does a bevelled needle that is steered by feedback hit what it aims at, in tissue that gives way?
 *
 *     needle_control [OPTIONS]              needle_control --help lists the options
 *
 * Repeats the experiment of section 12.2.1 of Chentanez, Interactive simulation of surgical needle insertion and
 * steering (2010): how far the needle bends is measured with a first insertion; then it is steered to random points of
 * the tissue, each in fresh tissue, after Hauser et al. 2009. With --push that of section 12.2.2: a straight needle is
 * not aimed at its target; the tissue is pushed at one point until the target lies in its way (Torabi et al. 2009).
 * Printed is a table, and last a line
 *
 *     targets=N hit=M within_mm=1.0 median_mm=... max_mm=... seconds=...
 *
 * Exit status: 0, 2 wrong usage or a file that cannot be read or written, 3 a step failed. */
#include "system.h"

#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#include "needle.h"

#include "needle_scene.h"
#include "options.h"

static const double pi = 3.14159265358979323846;
static const double outlet_height = 0.01; /* m, of the sleeve over the tissue */

typedef struct settings {
    const char *mesh, *output;
    double scale, young, poisson, friction, cutting, radius, error, within, speed, dt;
    int targets, seed, push, quiet, help;
} settings;

/* Needle, place and reach: the same for all targets. */
typedef struct trial {
    scene s;
    const settings *set;
    ndl_needle_def needle;
    ndl_friction friction;
    sb_vec3 entry;     /* m, on the tissue */
    double height;     /* m, of the tissue below it */
    double curvature;  /* 1/m, measured */
    unsigned long long seed;
    double *distances; /* mm, [targets] */
    int hits;
    FILE *table;
} trial;

/* ---- tissue and needle ---- */

static int make_tissue(trial *t)
{
    const settings *set = t->set;
    scene_def def = scene_default_def("needle_control");
    const double size[3] = {0.10, 0.10, 0.12};
    const int cells[3] = {7, 7, 8};
    def.mesh = set->mesh;
    def.scale = set->scale;
    def.young = set->young;
    def.poisson = set->poisson;
    memcpy(def.size, size, sizeof size);
    memcpy(def.cells, cells, sizeof cells);
    if (!scene_load(&t->s, &def))
        return 0;
    scene_hold(&t->s, 2, 0);
    return scene_renew(&t->s);
}

/* The needle goes straight down into the middle of the tissue's upper side; a little beside it in the box, so that it
 * does not run along the edges of the mesh. */
static int place_needle(trial *t)
{
    const settings *set = t->set;
    scene *s = &t->s;
    double beside = s->def.mesh ? 0 : 0.02;
    sb_vec3 above = sb_v3_scale((sb_real)0.5, sb_v3_add(s->low, s->high)), down = sb_v3(0, 0, -1);
    above.x += (sb_real)(beside * scene_extent(s, 0));
    above.y += (sb_real)(0.7 * beside * scene_extent(s, 1));
    above.z = s->high.z + (sb_real)outlet_height;
    if (!scene_hit(s, above, down, &t->entry))
        return scene_complain(s, s->def.mesh, "there is no tissue below the middle of its upper side");
    t->height = (double)(t->entry.z - s->low.z);
    if (t->height < 0.03 || t->height > 1)
        return scene_complain(s, s->def.mesh, "needles need tissue that is 3 cm to 1 m deep; see --scale");
    t->friction.friction = (sb_real)set->friction;
    t->friction.cutting = (sb_real)set->cutting;
    t->needle = ndl_default_needle_def();
    t->needle.base = t->entry;
    t->needle.base.z += (sb_real)outlet_height;
    t->needle.direction = down;
    t->needle.director = sb_v3(1, 0, 0);
    t->needle.length = (sb_real)(0.9 * outlet_height);
    t->needle.frictions = &t->friction;
    t->needle.friction_count = 1;
    if (!set->push) {
        ndl_rod_section_preset(NDL_NITINOL_083, &t->needle.section);
        t->needle.bevel.curvature = (sb_real)(1 / set->radius);
    }
    return 1;
}

/* How far the needle bends is measured with one insertion without a turn, of two thirds of the depth: by a circle
 * through the tip's places beyond the first fifth. */
static int measure_curvature(trial *t)
{
    scene_path path = {NULL, 0, 0};
    scene_circle circle;
    ndl_frame frame;
    ndl_command command;
    double depth = 0.67 * t->height, begin = 0.2 * depth;
    int good = scene_start(&t->s, &t->needle);
    memset(&command, 0, sizeof command);
    command.insertion = (sb_real)t->set->speed;
    while (good && (double)ndl_needle_fed(t->s.needle) < depth + outlet_height) {
        good = scene_step(&t->s, t->set->dt, &command, NULL);
        if (good && (double)ndl_needle_depth(t->s.needle) > begin)
            good = scene_record(&path, ndl_needle_tip(t->s.needle).position);
    }
    if (good) {
        frame = ndl_rod_frame(ndl_needle_rod(t->s.needle), 0);
        good = scene_fit_circle(path.points, path.count, t->entry, frame.t, frame.m2, &circle);
        if (!good)
            scene_complain(&t->s, "the first insertion", "the needle does not bend");
    }
    free(path.points);
    if (!good)
        return 0;
    t->curvature = 1 / circle.radius;
    printf("first insertion: the tip's way is a circle of %.1f mm (deviation %.2f mm, %.2f mm out of its plane); "
           "in rigid tissue %.1f mm\n",
           1e3 * circle.radius, 1e3 * circle.deviation, 1e3 * circle.aside, 1e3 * t->set->radius);
    return 1;
}

/* ---- targets ---- */

/* A point of the tissue that a needle which bends to at most three quarters of what was measured could come to, if the
 * tissue were rigid. */
static int choose_target(trial *t, scene_point *target, double *depth)
{
    ndl_tip_pose start, end;
    start.position = t->entry;
    start.frame.t = sb_v3(0, 0, -1);
    start.frame.m1 = sb_v3(1, 0, 0);
    start.frame.m2 = sb_v3_cross(start.frame.t, start.frame.m1);
    for (int attempt = 0; attempt < 1000; attempt++) {
        double turn = scene_random_in(&t->seed, -pi, pi), bend = 0.75 * sqrt(scene_random(&t->seed)) * t->curvature;
        double length = scene_random_in(&t->seed, 0.35, 0.65) * t->height;
        end = ndl_tip_turn(&start, (sb_real)turn);
        end = ndl_helix_pose(&end, (sb_real)bend, 0, (sb_real)length);
        *depth = length;
        if (scene_find(&t->s, end.position, target))
            return 1;
    }
    return scene_complain(&t->s, t->set->mesh, "has no room for targets below the middle of its upper side");
}

static int steer_to_target(trial *t, int number)
{
    const settings *set = t->set;
    scene_steering g;
    sb_vec3 moved;
    double depth, error = scene_random_in(&t->seed, -set->error, set->error), known = t->curvature * (1 + error);
    memset(&g, 0, sizeof g);
    if (!scene_start(&t->s, &t->needle) || !choose_target(t, &g.target, &depth))
        return 0;
    g.def = ndl_default_steer_def((sb_real)known, (sb_real)(2 * depth + outlet_height));
    g.def.step = (sb_real)(set->speed * set->dt);
    g.def.reach = (sb_real)(1e-3 * set->within);
    g.dt = set->dt;
    if (!scene_steer(&t->s, &g))
        return 0;
    moved = scene_where(&t->s, &g.target);
    t->distances[number] = 1e3 * g.distance;
    t->hits += t->distances[number] <= set->within;
    if (!set->quiet)
        printf("%4d  %7.2f %7.2f %7.2f  %+6.1f  %6.2f  %8.3f  %5d  %s\n", number + 1, 1e3 * (double)g.target.X.x,
               1e3 * (double)g.target.X.y, 1e3 * (double)g.target.X.z, 100 * error,
               1e3 * scene_distance(moved, g.target.X), t->distances[number], g.steps, scene_outcome(g.steer.status));
    if (t->table)
        fprintf(t->table, "%d,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g,%d,%s\n", number + 1, 1e3 * (double)g.target.X.x,
                1e3 * (double)g.target.X.y, 1e3 * (double)g.target.X.z, 100 * error,
                1e3 * scene_distance(moved, g.target.X), t->distances[number], g.steps,
                scene_outcome(g.steer.status));
    return 1;
}

/* ---- all ---- */

static int run_targets(trial *t)
{
    const settings *set = t->set;
    char words[64];
    if (!set->push && !measure_curvature(t))
        return 0;
    if (!set->quiet)
        printf("\n      target (mm)              known    moved  distance\n"
               "   #        x       y       z   to %%  by (mm)      (mm)  steps  outcome\n");
    for (int i = 0; i < set->targets; i++) {
        snprintf(words, sizeof words, "target %d of %d, %d hit", i + 1, set->targets, t->hits);
        progress_show((double)i / set->targets, words);
        if (!steer_to_target(t, i))
            return 0;
        fflush(stdout);
    }
    progress_end();
    return 1;
}

static int parse(settings *set, int argc, char **argv)
{
    const char *none[1] = {NULL};
    option options[] = {
        {"--targets", "N", OPTION_INTEGER, &set->targets, NULL, NULL, 1, 1e5, "number of targets"},
        {"--push", NULL, OPTION_FLAG, &set->push, NULL, NULL, 0, 0, "push the tissue, with a straight needle"},
        {"--mesh", "FILE", OPTION_TEXT, NULL, NULL, &set->mesh, 0, 0, "tissue of tet4; default a box of 2352 tets"},
        {"--scale", "S", OPTION_NUMBER, NULL, &set->scale, NULL, 1e-9, 1e9, "of its lengths, to metres"},
        {"--young", "PA", OPTION_NUMBER, NULL, &set->young, NULL, 100, 1e9, "of the tissue"},
        {"--poisson", "NU", OPTION_NUMBER, NULL, &set->poisson, NULL, 0, 0.49, "of the tissue"},
        {"--friction", "N/M", OPTION_NUMBER, NULL, &set->friction, NULL, 0, 1000, "along the shaft"},
        {"--cutting", "N", OPTION_NUMBER, NULL, &set->cutting, NULL, 0, 100, "force at the tip"},
        {"--radius", "M", OPTION_NUMBER, NULL, &set->radius, NULL, 0.05, 10, "of the needle's circles in rigid tissue"},
        {"--error", "SHARE", OPTION_NUMBER, NULL, &set->error, NULL, 0, 0.5,
         "to which the controller knows the curvature: measured times 1 - SHARE to 1 + SHARE"},
        {"--within", "MM", OPTION_NUMBER, NULL, &set->within, NULL, 0.01, 100, "what counts as hit"},
        {"--speed", "M/S", OPTION_NUMBER, NULL, &set->speed, NULL, 1e-4, 1, "of insertion"},
        {"--dt", "S", OPTION_NUMBER, NULL, &set->dt, NULL, 1e-3, 1, "step, after which the controller looks again"},
        {"--seed", "N", OPTION_INTEGER, &set->seed, NULL, NULL, 0, 1e9, "of chance"},
        {"-o", "PREFIX", OPTION_TEXT, NULL, NULL, &set->output, 0, 0, "writes the table to PREFIX.csv"},
        {"--quiet", NULL, OPTION_FLAG, &set->quiet, NULL, NULL, 0, 0, "no table"},
        {"--help", NULL, OPTION_FLAG, &set->help, NULL, NULL, 0, 0, "this text"},
    };
    int count = (int)(sizeof options / sizeof options[0]), good;
    settings defaults = *set;
    good = options_parse("needle_control", options, count, none, 0, argc, argv);
    if (good && set->help) {
        *set = defaults;
        set->help = 1;
        printf("usage: needle_control [OPTIONS]\n\nSteers a needle to random targets in soft tissue.\n\n");
        options_print(options, count);
    }
    return good;
}

static int run(trial *t, const settings *set)
{
    double begin = seconds_now(), median;
    if (!make_tissue(t) || !place_needle(t))
        return SCENE_USAGE;
    if (!run_targets(t))
        return SCENE_SOLVE;
    median = scene_median(t->distances, set->targets); /* sorted now */
    printf("targets=%d hit=%d within_mm=%.1f median_mm=%.3f max_mm=%.3f seconds=%.1f\n", set->targets, t->hits,
           set->within, median, t->distances[set->targets - 1], seconds_now() - begin);
    return SCENE_OK;
}

int main(int argc, char **argv)
{
    settings set = {NULL, NULL, 1, 30e3, 0.45, 20, 0.5, 0.1, 0.1, 1.0, 0.02, 0.05, 100, 1, 0, 0, 0};
    trial t;
    char path[1024];
    int status;
    if (!parse(&set, argc, argv))
        return SCENE_USAGE;
    if (set.help)
        return SCENE_OK;
    memset(&t, 0, sizeof t);
    t.set = &set;
    t.seed = (unsigned long long)set.seed;
    t.distances = (double *)calloc((size_t)set.targets, sizeof *t.distances);
    if (!t.distances)
        return SCENE_SOLVE;
    if (set.output) {
        snprintf(path, sizeof path, "%s.csv", set.output);
        t.table = fopen(path, "w");
        if (!t.table) {
            fprintf(stderr, "needle_control: %s cannot be written\n", path);
            free(t.distances);
            return SCENE_USAGE;
        }
        fprintf(t.table, "target,x_mm,y_mm,z_mm,curvature_error_percent,moved_mm,distance_mm,steps,outcome\n");
    }
    status = run(&t, &set);
    if (t.table)
        fclose(t.table);
    scene_end(&t.s);
    free(t.distances);
    return status;
}
