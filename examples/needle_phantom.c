/* needle_phantom: a bevelled needle in a block of gel with markers on its surface.
 *
 *     needle_phantom [OPTIONS]              needle_phantom --help lists the options
 *
 * The experiments of section 12.1.3 of Chentanez, Interactive simulation of surgical needle insertion and steering
 * (2010): a nitinol needle of 0.83 mm is pushed into the side of a gel block of 27.1 x 26.5 x 3.9 cm (E 125.89 kPa,
 * nu 0.453). Single bend: inserted and drawn back without a turn. Double bend: its base is turned by 180 degrees half
 * way. The block's far side is held. Writes, for each bend, PREFIX_BEND.csv (where markers are, with displacements) and
 * PREFIX_BEND.png (a look through the gel, markers' motions enlarged), and PREFIX.svg (paths and markers' motion over
 * time).
 *
 * --truth PREFIX compares with another run's markers, or with measured ones in files of the same form: PREFIX_BEND.csv
 * of the same markers, looked at at the same times. --sensitivity runs each bend 25 times, with E and nu up to two
 * standard deviations (15.551 kPa, 0.007) off, and prints the errors beside those of tables 12.1 and 12.2; they are in
 * PREFIX_sensitivity.csv.
 *
 * The last line is, with what belongs to the bends that were made,
 *
 *     markers=N single_rms_mm=... single_max_mm=... single_radius_mm=... single_deviation_mm=...
 *     double_rms_mm=... double_max_mm=... double_radius_mm=FIRST,SECOND double_deviation_mm=...
 *     topology=restored|changed seconds=...
 *
 * (one line). RMS and max are those of the way that all markers have moved, at all times. With --truth follow, before
 * the topology, single_error_mm=RMS single_error_max_mm=... single_under_1mm=SHARE single_under_2mm=SHARE, and the same
 * of the double bend. Exit status: 0, 2 wrong usage or a file that cannot be
 * read or written, 3 a step failed. */
#include "system.h"

#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#include "needle.h"

#include "needle_scene.h"
#include "options.h"
#include "plot.h"

static const double pi = 3.14159265358979323846;
static const double outlet_height = 0.01; /* m, of the sleeve before the block */

enum { BENDS = 2, MOST_MARKERS = 400, NAME_SIZE = 1024, OFFS = 5 };
static const char *const bend_names[BENDS] = {"single", "double"};

typedef struct settings {
    const char *mesh, *output, *bend, *truth;
    double scale, young, poisson, friction, cutting, radius, depth, speed, dt, azimuth, elevation;
    int cells, markers, every, seed, held, sensitivity, help;
} settings;

/* Where markers were, as a file says. */
typedef struct truth {
    sb_vec3 *x; /* [count] m, look by look, marker by marker */
    double *t;  /* [count] s */
    int count, capacity;
} truth;

/* Distances of markers from the truth. */
typedef struct error_sum {
    double square, most; /* m^2, m */
    long samples, under[2] /* 1 and 2 mm */;
} error_sum;

/* What is recorded of one bend. */
typedef struct record {
    scene_path path;             /* the tip's places while it goes in */
    int turned_at;               /* points of it before the half-turn; all without one */
    scene_circle circles[BENDS]; /* through the path before and after the turn */
    int circle_count;
    double *fed, *rms; /* [count] cm fed; mm, of all markers then */
    int count, capacity;
    double square, most; /* m^2, sum over all markers and times; m */
    long samples;
    error_sum error;
    double *curves[4]; /* x and y of path and needle (mm), for the chart */
    int curve_counts[2];
    int restored;
} record;

typedef struct phantom {
    scene s;
    const settings *set;
    ndl_needle_def needle;
    ndl_friction friction;
    sb_vec3 entry;
    scene_point markers[MOST_MARKERS];
    int marker_count;
    record records[BENDS];
    truth truths[BENDS]; /* empty without --truth */
    int made[BENDS];
} phantom;

/* ---- block, needle, markers ---- */

static int make_block(phantom *p)
{
    const settings *set = p->set;
    scene_def def = scene_default_def("needle_phantom");
    const double size[3] = {0.271, 0.265, 0.039};
    const int cells[3] = {set->cells, set->cells, (set->cells + 4) / 8}; /* 6 tets each; the thesis has 2280 in all */
    def.mesh = set->mesh;
    def.scale = set->scale;
    def.young = set->young;
    def.poisson = set->poisson;
    memcpy(def.size, size, sizeof size);
    memcpy(def.cells, cells, sizeof cells);
    if (!scene_load(&p->s, &def))
        return 0;
    scene_hold(&p->s, 0, 1);
    return scene_renew(&p->s);
}

/* Into the middle of the side at low x; it bends in the plane of the block, towards +y. */
static int place_needle(phantom *p)
{
    const settings *set = p->set;
    scene *s = &p->s;
    sb_vec3 before = sb_v3_scale((sb_real)0.5, sb_v3_add(s->low, s->high)), along = sb_v3(1, 0, 0);
    before.x = s->low.x - (sb_real)outlet_height;
    before.y += (sb_real)(0.004 * scene_extent(s, 1)); /* not along the edges of the block's mesh */
    before.z += (sb_real)(0.03 * scene_extent(s, 2));
    if (!scene_hit(s, before, along, &p->entry))
        return scene_complain(s, set->mesh, "there is no tissue behind the middle of its side at low x");
    if (set->depth > 0.95 * scene_extent(s, 0))
        return scene_complain(s, set->mesh, "is too short for --depth; see also --scale");
    p->friction.friction = (sb_real)set->friction;
    p->friction.cutting = (sb_real)set->cutting;
    p->needle = ndl_default_needle_def();
    p->needle.follow = set->held ? NDL_EMBED : NDL_REMESH;
    ndl_rod_section_preset(NDL_NITINOL_083, &p->needle.section);
    p->needle.base = p->entry;
    p->needle.base.x -= (sb_real)outlet_height;
    p->needle.direction = along;
    p->needle.director = sb_v3(0, 0, -1);
    p->needle.length = (sb_real)(0.9 * outlet_height);
    p->needle.bevel.curvature = (sb_real)(1 / set->radius);
    p->needle.frictions = &p->friction;
    p->needle.friction_count = 1;
    return 1;
}

/* Markers lie on the upper side, near the points of a grid: they are set by hand. */
static int place_markers(phantom *p)
{
    scene *s = &p->s;
    const int side = p->set->markers;
    unsigned long long seed = (unsigned long long)p->set->seed;
    for (int k = 0; k < side * side; k++) {
        double x = (k % side + 0.5 + scene_random_in(&seed, -0.25, 0.25)) / side;
        double y = (int)(k / side) + 0.5 + scene_random_in(&seed, -0.25, 0.25);
        sb_vec3 above = s->low, at;
        above.x += (sb_real)(x * scene_extent(s, 0));
        above.y += (sb_real)(y / side * scene_extent(s, 1));
        above.z = s->high.z + (sb_real)scene_extent(s, 2);
        if (!scene_hit(s, above, sb_v3(0, 0, -1), &at))
            continue;
        at.z -= (sb_real)(1e-6 * scene_extent(s, 2)); /* inside, whatever is rounded */
        p->marker_count += scene_find(s, at, p->markers + p->marker_count);
    }
    return p->marker_count > 0 ? 1 : scene_complain(s, p->set->mesh, "has no upper side for markers");
}

/* ---- the truth ---- */

static int keep_truth(truth *h, double t, sb_vec3 x)
{
    if (h->count == h->capacity) {
        int capacity = 2 * h->capacity + 1024;
        sb_vec3 *places = (sb_vec3 *)realloc(h->x, sizeof *places * (size_t)capacity);
        double *times = places ? (double *)realloc(h->t, sizeof *times * (size_t)capacity) : NULL;
        h->x = places ? places : h->x;
        if (!times)
            return 0;
        h->t = times;
        h->capacity = capacity;
    }
    h->t[h->count] = t;
    h->x[h->count++] = x;
    return 1;
}

/* Reads PREFIX_BEND.csv. 0, with a message, when that fails. */
static int read_truth(phantom *p, int bend)
{
    char path[NAME_SIZE], line[256];
    double t, fed, x, y, z;
    int marker, good = 1, number = 0;
    FILE *file;
    snprintf(path, sizeof path, "%s_%s.csv", p->set->truth, bend_names[bend]);
    file = fopen(path, "r");
    if (!file)
        return scene_complain(&p->s, path, "cannot be opened");
    while (good && fgets(line, sizeof line, file)) {
        if (number++ == 0)
            continue; /* names of columns */
        if (sscanf(line, "%lf,%lf,%d,%lf,%lf,%lf", &t, &fed, &marker, &x, &y, &z) != 6 ||
            marker != p->truths[bend].count % p->marker_count)
            good = scene_complain(&p->s, path, "has no rows of these markers");
        else if (!keep_truth(p->truths + bend, t, sb_v3((sb_real)(1e-3 * x), (sb_real)(1e-3 * y), (sb_real)(1e-3 * z))))
            good = scene_complain(&p->s, NULL, "memory is short");
    }
    fclose(file);
    return good && (p->truths[bend].count > 0 || scene_complain(&p->s, path, "is empty"));
}

/* A marker that is at x, the `row`th of its bend. 0, with a message: the truth was not looked at then. */
static int compare_marker(phantom *p, int bend, error_sum *error, long row, sb_vec3 x)
{
    const truth *h = p->truths + bend;
    double off;
    if (h->count == 0)
        return 1;
    if (row >= h->count || fabs(h->t[row] - p->s.time) > 0.5 * p->set->dt)
        return scene_complain(&p->s, p->set->truth, "was not looked at at the same times");
    off = scene_distance(x, h->x[row]);
    error->square += off * off;
    error->most = fmax(error->most, off);
    error->samples++;
    error->under[0] += off < 1e-3;
    error->under[1] += off < 2e-3;
    return 1;
}

static double error_rms(const error_sum *e) { return e->samples ? sqrt(e->square / (double)e->samples) : 0; }

/* ---- one bend ---- */

/* Notes where all markers are; table: or NULL. */
static int note_markers(phantom *p, record *r, FILE *table)
{
    const int bend = (int)(r - p->records);
    double square = 0;
    if (r->count == r->capacity) {
        int capacity = 2 * r->capacity + 256;
        double *fed = (double *)realloc(r->fed, sizeof(double) * (size_t)capacity);
        double *rms = fed ? (double *)realloc(r->rms, sizeof(double) * (size_t)capacity) : NULL;
        r->fed = fed ? fed : r->fed;
        if (!rms)
            return scene_complain(&p->s, NULL, "memory is short");
        r->rms = rms;
        r->capacity = capacity;
    }
    r->fed[r->count] = 100 * (double)ndl_needle_fed(p->s.needle);
    for (int k = 0; k < p->marker_count; k++) {
        sb_vec3 x = scene_where(&p->s, p->markers + k), X = p->markers[k].X, d = sb_v3_sub(x, X);
        double moved = (double)sb_v3_norm(d);
        square += moved * moved;
        r->most = fmax(r->most, moved);
        if (!compare_marker(p, bend, &r->error, r->samples + k, x))
            return 0;
        if (!table)
            continue;
        fprintf(table, "%.6g,%.4f,%d,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g\n", p->s.time, 10 * r->fed[r->count], k,
                1e3 * (double)x.x, 1e3 * (double)x.y, 1e3 * (double)x.z, 1e3 * (double)d.x, 1e3 * (double)d.y,
                1e3 * (double)d.z);
    }
    r->rms[r->count++] = 1e3 * sqrt(square / p->marker_count);
    r->square += square;
    r->samples += p->marker_count;
    return 1;
}

/* Feeds `length` (m), either sign, and turns the base by `turn` (rad) meanwhile; without a length in half a second. */
static int move(phantom *p, record *r, FILE *table, double length, double turn, const char *words)
{
    const settings *set = p->set;
    int steps = (int)ceil(fabs(length) / (set->speed * set->dt));
    ndl_command command;
    char bar[80];
    steps = steps > 0 ? steps : (int)ceil(0.5 / set->dt);
    memset(&command, 0, sizeof command);
    command.insertion = (sb_real)(length / (steps * set->dt));
    command.twist = (sb_real)(turn / (steps * set->dt));
    for (int i = 1; i <= steps; i++) {
        snprintf(bar, sizeof bar, "%s, %.1f cm", words, 100 * (double)ndl_needle_fed(p->s.needle));
        progress_show((double)i / steps, bar);
        if (!scene_step(&p->s, set->dt, &command, NULL))
            return 0;
        if (length > 0 && ndl_needle_depth(p->s.needle) > 0 &&
            !scene_record(&r->path, ndl_needle_tip(p->s.needle).position))
            return scene_complain(&p->s, NULL, "memory is short");
        if ((i % set->every == 0 || i == steps) && !note_markers(p, r, table))
            return 0;
    }
    return 1;
}

/* Circles through the path, which begins beyond the first tenth. */
static void fit_circles(phantom *p, record *r)
{
    int first = r->path.count / 10, middle = r->turned_at;
    sb_vec3 along = p->needle.direction, across = sb_v3(0, 1, 0);
    for (int k = 0; k < BENDS; k++) {
        int from = k == 0 ? first : middle, to = k == 0 ? middle : r->path.count;
        if (to - from > 2)
            r->circle_count += scene_fit_circle(r->path.points + from, to - from, p->entry, along, across,
                                                r->circles + r->circle_count);
    }
}

/* What the chart shows of the needle at its deepest. */
static int keep_curves(phantom *p, record *r)
{
    const ndl_rod *rod = ndl_needle_rod(p->s.needle);
    const sb_vec3 *x = ndl_rod_positions(rod);
    r->curve_counts[0] = r->path.count;
    r->curve_counts[1] = ndl_rod_node_count(rod);
    for (int k = 0; k < 4; k++) {
        r->curves[k] = (double *)malloc(sizeof(double) * (size_t)(r->curve_counts[k / 2] + 1));
        if (!r->curves[k])
            return scene_complain(&p->s, NULL, "memory is short");
        for (int i = 0; i < r->curve_counts[k / 2]; i++) {
            sb_vec3 d = sb_v3_sub(k < 2 ? r->path.points[i] : x[i], p->entry);
            r->curves[k][i] = 1e3 * (double)(k % 2 == 0 ? d.x : d.y);
        }
    }
    return 1;
}

static int save_picture(phantom *p, const char *path, const char *name)
{
    const record *r = p->records + (strcmp(name, bend_names[1]) == 0);
    double azimuth = p->set->azimuth, elevation = p->set->elevation, most = scene_most_motion(&p->s);
    double large = r->most > 0 ? picture_round_down(0.012 / r->most) : 1; /* markers' motions: about a centimetre */
    picture pic;
    char text[120];
    int result = PICTURE_NO_MEMORY;
    picture_begin(&pic, 1280, 960);
    if (scene_draw_tissue(&p->s, &pic, azimuth, elevation, most)) {
        for (int k = 0; k < p->marker_count; k++) {
            sb_vec3 X = p->markers[k].X, d = sb_v3_sub(scene_where(&p->s, p->markers + k), X);
            sb_vec3 end = sb_v3_add(X, sb_v3_scale((sb_real)large, d));
            picture_add_capsule(&pic, X, X, 0.0016, picture_web(0x2c3440));
            picture_add_capsule(&pic, X, end, 0.0006, picture_web(0x0072b2));
        }
        scene_draw_needle(&p->s, &pic, 0.0009);
        picture_render(&pic, azimuth, elevation);
        picture_colour_bar(&pic, "displacement", "mm", 0, 1e3 * most, 1e3 * most);
        picture_length_bar(&pic);
        snprintf(text, sizeof text, "Gel phantom, %s bend", name);
        picture_text(&pic, 77, 72, 22, PICTURE_LEFT, picture_ink(), text);
        snprintf(text, sizeof text, "markers on the upper side and their motion, %g times as long", large);
        picture_text(&pic, 77, 110, 14, PICTURE_LEFT, picture_ink(), text);
        result = picture_save_png(&pic, path);
    }
    picture_end(&pic);
    if (result != PICTURE_OK)
        scene_complain(&p->s, path, result == PICTURE_NO_FILE ? "cannot be written" : "memory is short");
    return result == PICTURE_OK;
}

/* In, with or without a half-turn, and out. table: or NULL, then there is no picture either. */
static int run_bend(phantom *p, int bend, FILE *table)
{
    record *r = p->records + bend;
    const char *name = bend_names[bend];
    double depth = p->set->depth, out;
    char path[NAME_SIZE];
    int good;
    snprintf(path, sizeof path, "%s_%s.png", p->set->output, name);
    good = scene_start(&p->s, &p->needle) && move(p, r, table, outlet_height + 0.5 * depth, 0, "goes in");
    r->turned_at = r->path.count;
    good = good && (bend == 0 || move(p, r, table, 0, pi, "turns")) && move(p, r, table, 0.5 * depth, 0, "goes in");
    if (bend == 0)
        r->turned_at = r->path.count;
    if (!good || !keep_curves(p, r) || (table && !save_picture(p, path, name)))
        return 0;
    fit_circles(p, r);
    out = -(depth + outlet_height);
    if (!move(p, r, table, out, 0, "goes out") || !move(p, r, table, 0, 0, "is out"))
        return 0;
    r->restored = p->set->held || ndl_remesh_is_original(ndl_needle_remesh(p->s.needle));
    p->made[bend] = 1;
    return 1;
}

static void forget(record *r)
{
    free(r->path.points);
    free(r->fed);
    free(r->rms);
    for (int k = 0; k < 4; k++)
        free(r->curves[k]);
    memset(r, 0, sizeof *r);
}

/* ---- sensitivity ---- */

static const double sd_young = 15.551e3, sd_poisson = 0.007;

/* The thesis' errors (mm), nu - 2 SD ... nu + 2 SD down, E - 2 SD ... E + 2 SD across: tables 12.1 and 12.2. */
static const double thesis[BENDS][OFFS][OFFS] = {{{0.924, 0.763, 0.741, 0.795, 0.888},
                                                  {0.919, 0.768, 0.755, 0.801, 0.885},
                                                  {0.916, 0.761, 0.753, 0.809, 0.893},
                                                  {0.910, 0.759, 0.755, 0.814, 0.894},
                                                  {0.900, 0.761, 0.752, 0.842, 0.929}},
                                                 {{1.684, 1.445, 1.276, 1.262, 1.313},
                                                  {1.702, 1.427, 1.295, 1.265, 1.334},
                                                  {1.721, 1.468, 1.309, 1.290, 1.340},
                                                  {1.762, 1.465, 1.308, 1.304, 1.344},
                                                  {1.758, 1.511, 1.365, 1.426, 1.406}}};

static void print_sensitivity(int bend, double errors[OFFS][OFFS])
{
    printf("%s bend: RMS of the markers' errors (mm), here and in the thesis\n"
           "nu \\ E  %13s  %13s  %13s  %13s  %13s\n",
           bend_names[bend], "-2 SD", "-SD", "mean", "+SD", "+2 SD");
    for (int i = 0; i < OFFS; i++) {
        printf("%+d SD   ", i - 2);
        for (int j = 0; j < OFFS; j++)
            printf("  %6.3f %6.3f", errors[i][j], thesis[bend][i][j]);
        printf("\n");
    }
}

/* All of one bend; its rows go into `table`. */
static int run_sensitivity(phantom *p, int bend, FILE *table)
{
    const settings *set = p->set;
    double errors[OFFS][OFFS];
    int good = 1;
    for (int i = 0; i < OFFS; i++)
        for (int j = 0; j < OFFS && good; j++) {
            p->s.def.young = set->young + (j - 2) * sd_young;
            p->s.def.poisson = set->poisson + (i - 2) * sd_poisson;
            forget(p->records + bend);
            good = run_bend(p, bend, NULL);
            errors[i][j] = 1e3 * error_rms(&p->records[bend].error);
            fprintf(table, "%s,%g,%g,%.4f,%.3f\n", bend_names[bend], p->s.def.young, p->s.def.poisson, errors[i][j],
                    thesis[bend][i][j]);
        }
    progress_end();
    p->s.def.young = set->young;
    p->s.def.poisson = set->poisson;
    if (good)
        print_sensitivity(bend, errors);
    return good;
}

/* ---- all ---- */

static int save_chart(const phantom *p, const char *path)
{
    plot chart;
    plot_panel *motion;
    plot_begin(&chart, "A needle in a gel phantom");
    for (int b = 0; b < BENDS; b++) {
        const record *r = p->records + b;
        plot_panel *panel;
        if (!p->made[b])
            continue;
        panel = plot_add_panel(&chart, b == 0 ? "single bend" : "double bend", "way into the gel (mm)", "aside (mm)");
        plot_add_curve(panel, "the tip's way", r->curves[0], r->curves[1], r->curve_counts[0]);
        plot_add_curve(panel, "needle, all the way in", r->curves[2], r->curves[3], r->curve_counts[1])->markers = 1;
    }
    motion = plot_add_panel(&chart, "motion of the markers", "needle out of its sleeve (cm)", "RMS (mm)");
    for (int b = 0; b < BENDS; b++)
        if (p->made[b])
            plot_add_curve(motion, bend_names[b], p->records[b].fed, p->records[b].rms, p->records[b].count);
    return plot_save_svg(&chart, path) ? 1 : scene_complain(&p->s, path, "cannot be written");
}

static void print_results(const phantom *p, double seconds)
{
    int restored = 1;
    printf("markers=%d ", p->marker_count);
    for (int b = 0; b < BENDS; b++) {
        const record *r = p->records + b;
        const char *name = bend_names[b];
        double deviation = 0;
        if (!p->made[b])
            continue;
        printf("%s_rms_mm=%.3f %s_max_mm=%.3f %s_radius_mm=", name, 1e3 * sqrt(r->square / (double)r->samples), name,
               1e3 * r->most, name);
        for (int k = 0; k < r->circle_count; k++) {
            printf("%s%.1f", k ? "," : "", 1e3 * r->circles[k].radius);
            deviation = fmax(deviation, r->circles[k].deviation);
        }
        printf("%s %s_deviation_mm=%.3f ", r->circle_count ? "" : "straight", name, 1e3 * deviation);
        if (r->error.samples)
            printf("%s_error_mm=%.3f %s_error_max_mm=%.3f %s_under_1mm=%.3f %s_under_2mm=%.3f ", name,
                   1e3 * error_rms(&r->error), name, 1e3 * r->error.most, name,
                   (double)r->error.under[0] / (double)r->error.samples, name,
                   (double)r->error.under[1] / (double)r->error.samples);
        restored = restored && r->restored;
    }
    printf("topology=%s seconds=%.1f\n", restored ? "restored" : "changed", seconds);
}

static int parse(settings *set, int argc, char **argv)
{
    const char *none[1] = {NULL};
    option options[] = {
        {"--bend", "BEND", OPTION_TEXT, NULL, NULL, &set->bend, 0, 0, "single, double or both"},
        {"--mesh", "FILE", OPTION_TEXT, NULL, NULL, &set->mesh, 0, 0, "tissue of tet4; default the gel block"},
        {"--scale", "S", OPTION_NUMBER, NULL, &set->scale, NULL, 1e-9, 1e9, "of its lengths, to metres"},
        {"--cells", "N", OPTION_INTEGER, &set->cells, NULL, NULL, 4, 64, "of the gel block's length"},
        {"--young", "PA", OPTION_NUMBER, NULL, &set->young, NULL, 100, 1e9, "of the gel"},
        {"--poisson", "NU", OPTION_NUMBER, NULL, &set->poisson, NULL, 0, 0.49, "of the gel"},
        {"--friction", "N/M", OPTION_NUMBER, NULL, &set->friction, NULL, 0, 1000, "along the shaft"},
        {"--cutting", "N", OPTION_NUMBER, NULL, &set->cutting, NULL, 0, 100, "force at the tip"},
        {"--radius", "M", OPTION_NUMBER, NULL, &set->radius, NULL, 0.05, 10, "of the needle's circles in rigid tissue"},
        {"--depth", "M", OPTION_NUMBER, NULL, &set->depth, NULL, 0.01, 1, "how far the needle goes in"},
        {"--markers", "N", OPTION_INTEGER, &set->markers, NULL, NULL, 1, 20, "in each row of as many rows"},
        {"--every", "N", OPTION_INTEGER, &set->every, NULL, NULL, 1, 1e6, "steps between looks at the markers"},
        {"--speed", "M/S", OPTION_NUMBER, NULL, &set->speed, NULL, 1e-4, 1, "of insertion"},
        {"--dt", "S", OPTION_NUMBER, NULL, &set->dt, NULL, 1e-3, 1, "step"},
        {"--azimuth", "DEG", OPTION_NUMBER, NULL, &set->azimuth, NULL, -360, 360, "of the pictures"},
        {"--elevation", "DEG", OPTION_NUMBER, NULL, &set->elevation, NULL, -90, 90, "of the pictures"},
        {"--seed", "N", OPTION_INTEGER, &set->seed, NULL, NULL, 0, 1e9, "of chance: where markers are set"},
        {"--held", NULL, OPTION_FLAG, &set->held, NULL, NULL, 0, 0,
         "springs hold the needle, the mesh stays (NDL_EMBED)"},
        {"--truth", "PREFIX", OPTION_TEXT, NULL, NULL, &set->truth, 0, 0, "of files of markers to compare with"},
        {"--sensitivity", NULL, OPTION_FLAG, &set->sensitivity, NULL, NULL, 0, 0,
         "errors with E and nu that are off; needs --truth"},
        {"-o", "PREFIX", OPTION_TEXT, NULL, NULL, &set->output, 0, 0, "of the files' names"},
        {"--help", NULL, OPTION_FLAG, &set->help, NULL, NULL, 0, 0, "this text"},
    };
    int count = (int)(sizeof options / sizeof options[0]), good;
    settings defaults = *set;
    good = options_parse("needle_phantom", options, count, none, 0, argc, argv);
    if (good && set->help) {
        *set = defaults;
        set->help = 1;
        printf("usage: needle_phantom [OPTIONS]\n\nPushes a bevelled needle into a gel block with markers.\n\n");
        options_print(options, count);
    } else if (good && strcmp(set->bend, "both") != 0 && strcmp(set->bend, "single") != 0 &&
               strcmp(set->bend, "double") != 0) {
        good = options_complain("needle_phantom", set->bend, "is no bend: single, double or both");
    }
    if (good && set->truth && strcmp(set->truth, set->output) == 0)
        good = options_complain("needle_phantom", "--truth", "names the files that -o writes");
    if (good && set->sensitivity && !set->truth)
        good = options_complain("needle_phantom", "--sensitivity", "needs a --truth");
    if (good && set->sensitivity && !(set->poisson + 2 * sd_poisson < 0.495 && set->young > 2.1 * sd_young))
        good = options_complain("needle_phantom", "--sensitivity", "needs E above 33 kPa and nu below 0.48");
    return good;
}

static int open_table(phantom *p, const char *ending, char path[NAME_SIZE], sb_output *table)
{
    snprintf(path, NAME_SIZE, "%s_%s.csv", p->set->output, ending);
    return sb_output_open(table, path, NULL) == SB_OK || scene_complain(&p->s, path, "cannot be written");
}

static int is_wanted(const phantom *p, int bend)
{
    return strcmp(p->set->bend, "both") == 0 || strcmp(p->set->bend, bend_names[bend]) == 0;
}

/* All bends with E and nu off. */
static int run_all_off(phantom *p)
{
    char path[NAME_SIZE];
    sb_output table;
    int good = 1;
    if (!open_table(p, "sensitivity", path, &table))
        return SCENE_USAGE;
    fprintf(table.file, "bend,young_pa,poisson,error_mm,thesis_mm\n");
    for (int b = 0; b < BENDS && good; b++)
        if (is_wanted(p, b))
            good = run_sensitivity(p, b, table.file);
    if (sb_output_close(&table, NULL) != SB_OK) {
        scene_complain(&p->s, path, "cannot be written");
        return SCENE_USAGE;
    }
    return good ? SCENE_OK : SCENE_SOLVE;
}

static int run(phantom *p)
{
    const settings *set = p->set;
    double begin = seconds_now();
    char path[NAME_SIZE];
    if (!make_block(p) || !place_needle(p) || !place_markers(p))
        return SCENE_USAGE;
    for (int b = 0; set->truth && b < BENDS; b++)
        if (is_wanted(p, b) && !read_truth(p, b))
            return SCENE_USAGE;
    if (set->sensitivity)
        return run_all_off(p);
    for (int b = 0; b < BENDS; b++) {
        sb_output table;
        int good, written;
        if (!is_wanted(p, b))
            continue;
        if (!open_table(p, bend_names[b], path, &table))
            return SCENE_USAGE;
        fprintf(table.file, "t,fed_mm,marker,x_mm,y_mm,z_mm,dx_mm,dy_mm,dz_mm\n");
        good = run_bend(p, b, table.file);
        progress_end();
        written = sb_output_close(&table, NULL) == SB_OK;
        if (!good)
            return SCENE_SOLVE;
        if (!written) {
            scene_complain(&p->s, path, "cannot be written");
            return SCENE_USAGE;
        }
        printf("%s and %s_%s.png written\n", path, set->output, bend_names[b]);
    }
    snprintf(path, sizeof path, "%s.svg", set->output);
    if (!save_chart(p, path))
        return SCENE_USAGE;
    printf("%s written\n", path);
    print_results(p, seconds_now() - begin);
    return SCENE_OK;
}

static void end(phantom *p)
{
    for (int b = 0; b < BENDS; b++) {
        forget(p->records + b);
        free(p->truths[b].x);
        free(p->truths[b].t);
    }
    scene_end(&p->s);
}

static int program(int argc, char **argv)
{
    settings set = {NULL, "phantom", "both", NULL, 1,  125.89e3, 0.453, 25, 0.5, 0.15, 0.16,
                    0.02, 0.05,      -6,     60,   24, 8,        5,     1,  0,   0,    0};
    phantom p;
    int status;
    if (!parse(&set, argc, argv))
        return SCENE_USAGE;
    if (set.help)
        return SCENE_OK;
    memset(&p, 0, sizeof p);
    p.set = &set;
    status = run(&p);
    end(&p);
    return status;
}

int main(int argc, char **argv) { return finish("needle_phantom", program(argc, argv), SCENE_USAGE); }
