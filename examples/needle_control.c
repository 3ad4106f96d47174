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
    double scale, young, poisson, friction, cutting, radius, error, within, force, speed, dt;
    int targets, seed, push, quiet, help;
} settings;

/* Needle, place and reach: the same for all targets. */
typedef struct trial {
    scene s;
    const settings *set;
    ndl_needle_def needle;
    ndl_friction friction;
    sb_vec3 entry;    /* m, on the tissue */
    double height;    /* m, of the tissue below it */
    double curvature; /* 1/m, measured */
    unsigned long long seed;
    double *distances; /* mm, [targets] */
    int hits;
    sb_output table; /* table.file is NULL: none is wanted */
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
    t->needle.follow = NDL_REMESH;
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
    } else {
        t->needle.section.radius = (sb_real)1e-3; /* steel: all but rigid in soft tissue */
    }
    return 1;
}

/* How far the needle bends is measured with one insertion without a turn, of two thirds of the depth: by a circle
 * through the points of the tissue that the tip cut, beyond the first fifth. */
static int measure_curvature(trial *t)
{
    scene_path path = {NULL, 0, 0};
    scene_circle circle;
    ndl_frame frame;
    ndl_command command;
    sb_vec3 X;
    double depth = 0.67 * t->height, begin = 0.2 * depth;
    int good = scene_start(&t->s, &t->needle);
    memset(&command, 0, sizeof command);
    command.insertion = (sb_real)t->set->speed;
    while (good && (double)ndl_needle_fed(t->s.needle) < depth + outlet_height) {
        good = scene_step(&t->s, t->set->dt, &command, NULL);
        if (good && (double)ndl_needle_depth(t->s.needle) > begin && ndl_needle_tip_material(t->s.needle, &X))
            good = scene_record(&path, X);
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

/* A line of the table. extra: how wrong the controller is about the needle (%), or what it pushes with (N). */
static void report(trial *t, int number, scene_point *target, double extra, double distance, int steps,
                   const char *outcome)
{
    const settings *set = t->set;
    double moved = 1e3 * scene_distance(scene_where(&t->s, target), target->X);
    double x = 1e3 * (double)target->X.x, y = 1e3 * (double)target->X.y, z = 1e3 * (double)target->X.z;
    t->distances[number] = 1e3 * distance;
    t->hits += 1e3 * distance <= set->within;
    if (!set->quiet)
        printf("%4d  %7.2f %7.2f %7.2f  %+6.1f  %6.2f  %8.3f  %5d  %s\n", number + 1, x, y, z, extra, moved,
               1e3 * distance, steps, outcome);
    if (t->table.file)
        fprintf(t->table.file, "%d,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g,%d,%s\n", number + 1, x, y, z, extra, moved,
                1e3 * distance, steps, outcome);
}

static int steer_to_target(trial *t, int number)
{
    const settings *set = t->set;
    scene_steering g;
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
    report(t, number, &g.target, 100 * error, g.distance, g.steps, scene_outcome(g.steer.status));
    return 1;
}

/* ---- pushing the tissue ---- */

enum { PLACES = 8, MOST_PAD_NODES = 64 };
static const double pad_radius = 0.015; /* m; what pushes is as wide as a finger */

/* Where the tissue may be pushed: the nodes of its surface under the pad, and the direction into the tissue. */
typedef struct pad {
    int nodes[MOST_PAD_NODES], count;
    sb_vec3 direction;
} pad;

/* A point beside the needle's path, by 1 to 3 mm. */
static int choose_aside(trial *t, scene_point *target)
{
    for (int attempt = 0; attempt < 1000; attempt++) {
        double angle = scene_random_in(&t->seed, -pi, pi), aside = scene_random_in(&t->seed, 1e-3, 3e-3);
        sb_vec3 X = t->entry;
        X.x += (sb_real)(aside * cos(angle));
        X.y += (sb_real)(aside * sin(angle));
        X.z -= (sb_real)(scene_random_in(&t->seed, 0.35, 0.65) * t->height);
        if (scene_find(&t->s, X, target))
            return 1;
    }
    return scene_complain(&t->s, t->set->mesh, "has no room for targets below the middle of its upper side");
}

/* The free nodes of the surface (its nodes are those of the mesh) under a pad at a place. */
static void find_pad_nodes(const trial *t, const sb_boundary *boundary, sb_vec3 at, pad *p)
{
    const unsigned char *held = sb_body_supports(t->s.body);
    p->count = 0;
    for (int i = 0; i < boundary->surface.node_count && p->count < MOST_PAD_NODES; i++)
        if (!held[boundary->nodes[i]] && scene_distance(boundary->surface.nodes[i], at) < pad_radius)
            p->nodes[p->count++] = boundary->nodes[i];
}

/* The places on the surface of the tissue at rest round about the target, at its height; returns how many. */
static int find_pads(trial *t, sb_vec3 target, pad *pads)
{
    double reach = scene_distance(t->s.low, t->s.high);
    sb_boundary boundary;
    sb_error error;
    int count = 0;
    if (sb_mesh_boundary(&t->s.mesh, 1, NULL, &boundary, &error) != SB_OK)
        return scene_complain_of(&t->s, &error);
    for (int k = 0; k < PLACES; k++) {
        double angle = 2 * pi * k / (double)PLACES;
        pad *p = pads + count;
        sb_vec3 inward = sb_v3((sb_real)-cos(angle), (sb_real)-sin(angle), 0), at;
        if (!scene_hit(&t->s, sb_v3_sub(target, sb_v3_scale((sb_real)reach, inward)), inward, &at))
            continue;
        p->direction = inward;
        find_pad_nodes(t, &boundary, at, p);
        count += p->count > 0;
    }
    sb_boundary_free(&boundary);
    return count;
}

/* The force on the pad, and no other. */
static int press(trial *t, const pad *p, sb_vec3 force)
{
    sb_vec3 part = sb_v3_scale(1 / (sb_real)p->count, force);
    sb_error error;
    sb_body_clear_loads(t->s.body);
    return sb_body_apply_forces(t->s.body, p->nodes, p->count, &part, 1, &error) == SB_OK ||
           scene_complain(&t->s, "pushing", error.message);
}

/* The force on a point of the tissue, and no other. */
static int press_point(trial *t, const scene_point *target, sb_vec3 force)
{
    scene_point point = *target;
    double weights[4];
    sb_vec3 parts[4];
    sb_error error;
    scene_locate(&t->s, &point, weights);
    for (int c = 0; c < 4; c++)
        parts[c] = sb_v3_scale((sb_real)weights[c], force);
    sb_body_clear_loads(t->s.body);
    return sb_body_apply_forces(t->s.body, sb_body_cell_nodes(t->s.body, point.cell), 4, parts, 0, &error) == SB_OK ||
           scene_complain(&t->s, "the force on the target", error.message);
}

/* How the target follows each pad, from the model of the tissue. Compliance is symmetric: with a force on the target
 * the pads tell in three solutions what else would take three for each. */
static int measure_compliances(trial *t, const scene_point *target, const pad *pads, int count, sb_mat3 *compliances)
{
    double force = 1e-3 * t->set->young * pad_radius * pad_radius;
    for (int axis = 0; axis < 3; axis++) {
        sb_vec3 f =
            sb_v3((sb_real)(axis == 0 ? force : 0), (sb_real)(axis == 1 ? force : 0), (sb_real)(axis == 2 ? force : 0));
        if (!press_point(t, target, f))
            return 0;
        for (int i = 0; i < 15; i++) /* to rest */
            if (!scene_step(&t->s, t->set->dt, NULL, NULL))
                return 0;
        for (int k = 0; k < count; k++) {
            sb_vec3 mean = sb_v3(0, 0, 0);
            for (int n = 0; n < pads[k].count; n++)
                mean = sb_v3_add(mean, sb_body_displacements(t->s.body)[pads[k].nodes[n]]);
            mean = sb_v3_scale((sb_real)(1 / (force * pads[k].count)), mean);
            compliances[k].m[axis][0] = mean.x;
            compliances[k].m[axis][1] = mean.y;
            compliances[k].m[axis][2] = mean.z;
        }
    }
    return 1;
}

/* Pushes until the target is in the needle's way, then inserts the needle to its height while the push goes on; the
 * needle waits while the target is far off, but not for ever: the push may not be able to do more. */
static int push_and_insert(trial *t, scene_point *target, const pad *p, ndl_push *push, int *steps)
{
    const settings *set = t->set;
    ndl_command command;
    sb_vec3 force, point;
    const int patience = 200;                 /* steps of waiting in all */
    const double near = 0.3e-3 * set->within; /* m: then an insertion that is under way goes on */
    int waited = 0;
    memset(&command, 0, sizeof command);
    for (*steps = 0; *steps < 100000; ++*steps) {
        double left, off = (double)sb_v3_norm(push->error), speed = 0;
        point = scene_where(&t->s, target);
        left = (double)(ndl_needle_tip(t->s.needle).position.z - point.z);
        if (push->arrived || (ndl_needle_depth(t->s.needle) > 0 && off < near) || waited >= patience)
            speed = 0.5 * set->speed;
        waited += speed == 0;
        if (left < 0.01 * set->speed * set->dt)
            return 1;
        command.insertion = (sb_real)fmin(speed, left / set->dt);
        if (ndl_push_update(push, point, (sb_real)set->dt, &force) != SB_OK)
            return scene_complain(&t->s, "pushing", "the target is lost");
        if (!press(t, p, force) || !scene_step(&t->s, set->dt, &command, NULL))
            return 0;
    }
    return 1;
}

static int push_to_target(trial *t, int number)
{
    const settings *set = t->set;
    scene_point target;
    pad pads[PLACES];
    sb_mat3 compliances[PLACES];
    sb_vec3 directions[PLACES];
    ndl_push_def def = ndl_default_push_def();
    ndl_push push;
    sb_error error;
    int count, best, steps, ok;
    if (!scene_renew(&t->s) || !choose_aside(t, &target))
        return 0;
    count = find_pads(t, target.X, pads);
    if (count == 0)
        return scene_complain(&t->s, set->mesh, "has no free surface beside the target to push at");
    if (!measure_compliances(t, &target, pads, count, compliances) || !scene_start(&t->s, &t->needle))
        return 0;
    def.line_point = t->entry;
    def.line_direction = t->needle.direction;
    def.max_force = (sb_real)set->force;
    def.proportional = (sb_real)0.1; /* soft tissue sways: less than the defaults */
    def.integral = 2;
    def.tolerance = (sb_real)(0.1e-3 * set->within);
    for (int k = 0; k < count; k++)
        directions[k] = pads[k].direction;
    ok = ndl_push_choose(&def, compliances, directions, count, target.X, &best, NULL, NULL, &error) == SB_OK;
    def.compliance = compliances[ok ? best : 0];
    def.direction = directions[ok ? best : 0];
    if (!ok || ndl_push_begin(&def, &push, &error) != SB_OK)
        return scene_complain(&t->s, "pushing", error.message);
    if (!push_and_insert(t, &target, pads + best, &push, &steps))
        return 0;
    report(t, number, &target, (double)sb_v3_norm(push.force),
           scene_distance(ndl_needle_tip(t->s.needle).position, scene_where(&t->s, &target)), steps,
           push.limited ? "limited" : "arrived");
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
        printf("      target (mm)               %s    moved  distance\n"
               "   #        x       y       z  %s  by (mm)      (mm)  steps  outcome\n",
               set->push ? "force" : "known", set->push ? "   (N)" : "to (%)");
    for (int i = 0; i < set->targets; i++) {
        snprintf(words, sizeof words, "target %d of %d, %d hit", i + 1, set->targets, t->hits);
        progress_show((double)i / set->targets, words);
        if (set->push ? !push_to_target(t, i) : !steer_to_target(t, i))
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
        {"--force", "N", OPTION_NUMBER, NULL, &set->force, NULL, 1e-3, 1000, "most that --push may push with"},
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

static int program(int argc, char **argv)
{
    settings set = {NULL, NULL, 1, 20e3, 0.45, 20, 0.5, 0.1, 0.1, 1.0, 10, 0.02, 0.05, 100, 1, 0, 0, 0};
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
        if (sb_output_open(&t.table, path, NULL) != SB_OK) {
            fprintf(stderr, "needle_control: %s cannot be written\n", path);
            free(t.distances);
            return SCENE_USAGE;
        }
        fprintf(t.table.file, "target,x_mm,y_mm,z_mm,%s,moved_mm,distance_mm,steps,outcome\n",
                set.push ? "force_n" : "curvature_error_percent");
    }
    status = run(&t, &set);
    if (t.table.file && sb_output_close(&t.table, NULL) != SB_OK) {
        fprintf(stderr, "needle_control: %s cannot be written\n", path);
        status = status ? status : SCENE_USAGE;
    }
    scene_end(&t.s);
    free(t.distances);
    return status;
}

int main(int argc, char **argv) { return finish("needle_control", program(argc, argv), SCENE_USAGE); }
