/* needle_obstacles: a bevelled needle is steered around two cylinders to a target behind them, in soft tissue.
 *
 *     needle_obstacles [OPTIONS]            needle_obstacles --help lists the options
 *
 * The example of section 12.1.2 of Chentanez, Interactive simulation of surgical needle insertion and steering (2010):
 * two fixed cylinders stand in the needle's way, one behind the other, so that it has to bend to one side and back.
 * The least distance from the whole shaft to the cylinders is taken after every step. Writes PREFIX.png (a look into
 * the tissue), PREFIX.csv (tip, target and clearance after each step) and PREFIX.vtk (the tissue, deformed). The last
 * line is
 *
 *     reached=1|0 distance_mm=... clearance_mm=... steps=N median_ms=... seconds=...
 *
 * Exit status: 0, 1 the target was missed or a cylinder touched, 2 wrong usage or a file that cannot be read or
 * written, 3 a step failed. */
#include "system.h"

#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#include "needle.h"

#include "needle_scene.h"
#include "options.h"

static const double outlet_height = 0.01; /* m, of the sleeve over the tissue */

enum { OBSTACLES = 2, MOST_TIMES = 20000, MISSED = 1 };

typedef struct settings {
    const char *mesh, *output;
    double scale, young, poisson, friction, cutting, radius, cylinder, error, margin, within, speed, dt, azimuth;
    double elevation;
    int seed, help;
} settings;

typedef struct course {
    scene s;
    const settings *set;
    ndl_needle_def needle;
    ndl_friction friction;
    ndl_obstacle obstacles[OBSTACLES];
    scene_path path;
    double needle_radius, clearance, most_motion; /* m */
    double *times;                                /* ms, [MOST_TIMES] */
    int time_count;
    double length, straight; /* m: of the straight way, and its distance from the cylinders */
    double last;             /* s, when the last step ended */
    sb_output table;
    scene_steering steering;
} course;

/* ---- tissue, cylinders and needle ---- */

/* Places in the tissue by shares of its box. */
static sb_vec3 place(const scene *s, double x, double y, double z)
{
    return sb_v3_add(s->low, sb_v3((sb_real)(x * scene_extent(s, 0)), (sb_real)(y * scene_extent(s, 1)),
                                   (sb_real)(z * scene_extent(s, 2))));
}

/* Both cylinders run from side to side, across the plane in which the needle has to bend: one in the straight way and
 * a little to the left, the other one deeper and to the right, so that the needle passes between them. */
static void make_obstacles(course *c)
{
    for (int k = 0; k < OBSTACLES; k++) {
        double x = k == 0 ? 0.44 : 0.63, z = k == 0 ? 0.68 : 0.34;
        ndl_obstacle *o = c->obstacles + k;
        memset(o, 0, sizeof *o);
        o->kind = NDL_OBSTACLE_CYLINDER;
        o->a = place(&c->s, x, 0, z);
        o->b = place(&c->s, x, 1, z);
        o->radius = (sb_real)(c->set->cylinder);
    }
}

/* The cylinders are fixed: tissue inside of them cannot move. */
static void hold_cylinders(course *c)
{
    for (int i = 0; i < c->s.mesh.node_count; i++)
        for (int k = 0; k < OBSTACLES; k++)
            if (ndl_obstacle_distance(c->obstacles + k, c->s.mesh.nodes[i]) < 0)
                scene_hold_node(&c->s, i);
}

static int make_tissue(course *c)
{
    const settings *set = c->set;
    scene_def def = scene_default_def("needle_obstacles");
    const double size[3] = {0.10, 0.07, 0.12};
    const int cells[3] = {9, 6, 10};
    def.mesh = set->mesh;
    def.scale = set->scale;
    def.young = set->young;
    def.poisson = set->poisson;
    memcpy(def.size, size, sizeof size);
    memcpy(def.cells, cells, sizeof cells);
    if (!scene_load(&c->s, &def))
        return 0;
    scene_hold(&c->s, 2, 0);
    make_obstacles(c);
    hold_cylinders(c);
    return scene_renew(&c->s);
}

static int place_needle(course *c)
{
    const settings *set = c->set;
    scene *s = &c->s;
    sb_vec3 above = place(s, 0.5, 0.52, 1), entry, target = place(s, 0.5, 0.52, 0.14);
    above.z += (sb_real)outlet_height;
    if (!scene_hit(s, above, sb_v3(0, 0, -1), &entry))
        return scene_complain(s, set->mesh, "there is no tissue below the middle of its upper side");
    if (scene_extent(s, 2) < 0.05 || scene_extent(s, 2) > 1)
        return scene_complain(s, set->mesh, "the course needs tissue that is 5 cm to 1 m high; see --scale");
    if (!scene_find(s, target, &c->steering.target))
        return scene_complain(s, set->mesh, "there is no tissue where the target should be");
    c->length = scene_distance(entry, target);
    c->friction.friction = (sb_real)set->friction;
    c->friction.cutting = (sb_real)set->cutting;
    c->needle = ndl_default_needle_def();
    ndl_rod_section_preset(NDL_NITINOL_083, &c->needle.section);
    c->needle_radius = (double)c->needle.section.radius;
    c->needle.base = entry;
    c->needle.base.z += (sb_real)outlet_height;
    c->needle.direction = sb_v3(0, 0, -1);
    c->needle.director = sb_v3(1, 0, 0);
    c->needle.length = (sb_real)(0.9 * outlet_height);
    c->needle.bevel.curvature = (sb_real)(1 / set->radius);
    c->needle.frictions = &c->friction;
    c->needle.friction_count = 1;
    return 1;
}

/* ---- the way ---- */

/* Distance (m) from a segment to the nearest cylinder, at so many places of it. */
static double segment_clearance(const course *c, sb_vec3 from, sb_vec3 to, int places)
{
    double least = 1e300;
    for (int i = 0; i <= places; i++) {
        sb_vec3 p = sb_v3_add(from, sb_v3_scale((sb_real)i / (sb_real)places, sb_v3_sub(to, from)));
        for (int k = 0; k < OBSTACLES; k++)
            least = fmin(least, (double)ndl_obstacle_distance(c->obstacles + k, p));
    }
    return least - c->needle_radius;
}

/* The same of the whole shaft. */
static double shaft_clearance(const course *c)
{
    const ndl_rod *rod = ndl_needle_rod(c->s.needle);
    const sb_vec3 *x = ndl_rod_positions(rod);
    double least = 1e300;
    for (int i = 0; i + 1 < ndl_rod_node_count(rod); i++)
        least = fmin(least, segment_clearance(c, x[i], x[i + 1], 8));
    return least;
}

static int after_step(void *user, scene *s, const ndl_steer *steer)
{
    course *c = (course *)user;
    sb_vec3 tip = ndl_needle_tip(s->needle).position, target = scene_where(s, &c->steering.target);
    double clearance = shaft_clearance(c), now = seconds_now();
    char words[80];
    if (c->time_count < MOST_TIMES)
        c->times[c->time_count++] = 1e3 * (now - c->last);
    c->clearance = fmin(c->clearance, clearance);
    c->most_motion = fmax(c->most_motion, scene_distance(target, c->steering.target.X));
    if (c->table.file)
        fprintf(c->table.file, "%.6g,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g\n", s->time, 1e3 * (double)tip.x,
                1e3 * (double)tip.y, 1e3 * (double)tip.z, 1e3 * (double)target.x, 1e3 * (double)target.y,
                1e3 * (double)target.z, 1e3 * scene_distance(tip, target), 1e3 * clearance);
    snprintf(words, sizeof words, "%.1f mm to go, clearance %.2f mm", 1e3 * scene_distance(tip, target),
             1e3 * clearance);
    progress_show((double)steer->inserted / c->length, words);
    if (!scene_record(&c->path, tip))
        return scene_complain(s, NULL, "memory is short");
    c->last = seconds_now();
    return 1;
}

static int steer(course *c)
{
    const settings *set = c->set;
    unsigned long long seed = (unsigned long long)set->seed;
    double error = scene_random_in(&seed, -set->error, set->error);
    scene_steering *g = &c->steering;
    int good;
    g->def = ndl_default_steer_def((sb_real)((1 + error) / set->radius), (sb_real)(1.5 * c->length + outlet_height));
    g->def.step = (sb_real)(set->speed * set->dt);
    g->def.reach = (sb_real)(1e-3 * set->within);
    g->def.plan.obstacles = c->obstacles;
    g->def.plan.obstacle_count = OBSTACLES;
    g->def.plan.clearance = (sb_real)(c->needle_radius + 1e-3 * set->margin);
    g->dt = set->dt;
    g->after_step = after_step;
    g->user = c;
    c->clearance = 1e300;
    c->straight = segment_clearance(c, c->needle.base, g->target.X, 200);
    c->last = seconds_now();
    good = scene_steer(&c->s, g);
    progress_end();
    return good;
}

/* ---- output ---- */

static int save_picture(course *c, const char *path)
{
    picture p;
    double most = scene_most_motion(&c->s), thick = 1.5 * c->needle_radius;
    sb_vec3 target = scene_where(&c->s, &c->steering.target);
    char text[120];
    int result = PICTURE_NO_MEMORY;
    picture_begin(&p, 1280, 960);
    if (scene_draw_tissue(&c->s, &p, c->set->azimuth, c->set->elevation, most)) {
        for (int k = 0; k < OBSTACLES; k++)
            picture_add_capsule(&p, c->obstacles[k].a, c->obstacles[k].b, (double)c->obstacles[k].radius,
                                picture_web(0x5b8fb9));
        scene_draw_path(&p, &c->path, 0.6 * thick, 0x009e73);
        scene_draw_needle(&c->s, &p, thick);
        picture_add_capsule(&p, target, target, 0.002, picture_web(0xd62728));
        picture_render(&p, c->set->azimuth, c->set->elevation);
        picture_colour_bar(&p, "displacement", "mm", 0, 1e3 * most, 1e3 * most);
        picture_length_bar(&p);
        picture_text(&p, 77, 72, 22, PICTURE_LEFT, picture_ink(), "A needle steered around two cylinders");
        snprintf(text, sizeof text, "%.2f mm from the target, least clearance %.2f mm", 1e3 * c->steering.distance,
                 1e3 * c->clearance);
        picture_text(&p, 77, 110, 14, PICTURE_LEFT, picture_ink(), text);
        result = picture_save_png(&p, path);
    }
    picture_end(&p);
    if (result != PICTURE_OK)
        scene_complain(&c->s, path, result == PICTURE_NO_FILE ? "cannot be written" : "memory is short");
    return result == PICTURE_OK;
}

static int save(course *c)
{
    char path[1024];
    snprintf(path, sizeof path, "%s.vtk", c->set->output);
    if (!scene_save(&c->s, path))
        return 0;
    snprintf(path, sizeof path, "%s.png", c->set->output);
    return save_picture(c, path);
}

static int parse(settings *set, int argc, char **argv)
{
    const char *none[1] = {NULL};
    option options[] = {
        {"--mesh", "FILE", OPTION_TEXT, NULL, NULL, &set->mesh, 0, 0, "tissue of tet4; default a box of 3240 tets"},
        {"--scale", "S", OPTION_NUMBER, NULL, &set->scale, NULL, 1e-9, 1e9, "of its lengths, to metres"},
        {"--young", "PA", OPTION_NUMBER, NULL, &set->young, NULL, 100, 1e9, "of the tissue"},
        {"--poisson", "NU", OPTION_NUMBER, NULL, &set->poisson, NULL, 0, 0.49, "of the tissue"},
        {"--friction", "N/M", OPTION_NUMBER, NULL, &set->friction, NULL, 0, 1000, "along the shaft"},
        {"--cutting", "N", OPTION_NUMBER, NULL, &set->cutting, NULL, 0, 100, "force at the tip"},
        {"--radius", "M", OPTION_NUMBER, NULL, &set->radius, NULL, 0.02, 10, "of the needle's circles in rigid tissue"},
        {"--cylinder", "M", OPTION_NUMBER, NULL, &set->cylinder, NULL, 1e-4, 1, "radius of the cylinders"},
        {"--margin", "MM", OPTION_NUMBER, NULL, &set->margin, NULL, 0, 100, "that the tip's way keeps from them"},
        {"--error", "SHARE", OPTION_NUMBER, NULL, &set->error, NULL, 0, 0.5,
         "to which the controller knows the curvature"},
        {"--within", "MM", OPTION_NUMBER, NULL, &set->within, NULL, 0.01, 100, "what counts as hit"},
        {"--speed", "M/S", OPTION_NUMBER, NULL, &set->speed, NULL, 1e-4, 1, "of insertion"},
        {"--dt", "S", OPTION_NUMBER, NULL, &set->dt, NULL, 1e-3, 1, "step, after which the controller looks again"},
        {"--azimuth", "DEG", OPTION_NUMBER, NULL, &set->azimuth, NULL, -360, 360, "of the picture"},
        {"--elevation", "DEG", OPTION_NUMBER, NULL, &set->elevation, NULL, -90, 90, "of the picture"},
        {"--seed", "N", OPTION_INTEGER, &set->seed, NULL, NULL, 0, 1e9, "of chance"},
        {"-o", "PREFIX", OPTION_TEXT, NULL, NULL, &set->output, 0, 0, "of the files' names"},
        {"--help", NULL, OPTION_FLAG, &set->help, NULL, NULL, 0, 0, "this text"},
    };
    int count = (int)(sizeof options / sizeof options[0]), good;
    settings defaults = *set;
    good = options_parse("needle_obstacles", options, count, none, 0, argc, argv);
    if (good && set->help) {
        *set = defaults;
        set->help = 1;
        printf("usage: needle_obstacles [OPTIONS]\n\nSteers a needle around two cylinders to a target.\n\n");
        options_print(options, count);
    }
    return good;
}

static int run(course *c)
{
    double begin = seconds_now();
    int reached;
    if (!make_tissue(c) || !place_needle(c) || !scene_start(&c->s, &c->needle))
        return SCENE_USAGE;
    if (!steer(c))
        return SCENE_SOLVE;
    if (!save(c))
        return SCENE_USAGE;
    reached = c->steering.distance <= 1e-3 * c->set->within;
    printf("on the straight way the needle would be %.2f mm %s a cylinder\n", 1e3 * fabs(c->straight),
           c->straight < 0 ? "inside of" : "clear of");
    printf("the target moved by up to %.2f mm; the controller ended with: %s\n", 1e3 * c->most_motion,
           scene_outcome(c->steering.steer.status));
    if (c->clearance < 0.9e-3 * c->set->margin) /* a bent shaft lies off its tip's way; wider turns keep more */
        printf("the shaft came within %.2f mm of a cylinder, nearer than the %.2f mm of its tip's way: it has too "
               "little room to bend\n",
               1e3 * c->clearance, c->set->margin);
    printf("%s.png, %s.csv and %s.vtk written\n", c->set->output, c->set->output, c->set->output);
    printf("reached=%d distance_mm=%.3f clearance_mm=%.3f steps=%d median_ms=%.2f seconds=%.1f\n", reached,
           1e3 * c->steering.distance, 1e3 * c->clearance, c->steering.steps, scene_median(c->times, c->time_count),
           seconds_now() - begin);
    return reached && c->clearance > 0 ? (int)SCENE_OK : (int)MISSED;
}

static int program(int argc, char **argv)
{
    settings set = {NULL, "obstacles", 1, 30e3, 0.45, 20, 0.5, 0.08, 0.006, 0.1, 2.0, 1.0, 0.02, 0.05, 7, 13, 1, 0};
    course c;
    char path[1024];
    int status;
    if (!parse(&set, argc, argv))
        return SCENE_USAGE;
    if (set.help)
        return SCENE_OK;
    memset(&c, 0, sizeof c);
    c.set = &set;
    snprintf(path, sizeof path, "%s.csv", set.output);
    if (sb_output_open(&c.table, path, NULL) != SB_OK) {
        fprintf(stderr, "needle_obstacles: %s cannot be written\n", path);
        return SCENE_USAGE;
    }
    fprintf(c.table.file,
            "t,tip_x_mm,tip_y_mm,tip_z_mm,target_x_mm,target_y_mm,target_z_mm,distance_mm,clearance_mm\n");
    c.times = (double *)malloc(MOST_TIMES * sizeof *c.times);
    status = c.times ? run(&c) : SCENE_SOLVE;
    if (sb_output_close(&c.table, NULL) != SB_OK) {
        fprintf(stderr, "needle_obstacles: %s cannot be written\n", path);
        status = status && status != MISSED ? status : (int)SCENE_USAGE;
    }
    scene_end(&c.s);
    free(c.path.points);
    free(c.times);
    return status;
}

int main(int argc, char **argv) { return finish("needle_obstacles", program(argc, argv), SCENE_USAGE); }
