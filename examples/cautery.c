/* cautery: the tip of a cautery burns its way through an organ, frame by frame, and what it takes is weighed.
 *
 *     cautery [ORGAN] [OPTIONS]      cautery --help lists the options
 *
 * Without a file an organ like a liver is made. It lies on its lower side; the tip goes to and fro over its middle,
 * just below the skin where it is by then, or along a path that a file has:
 *
 *     # comment
 *     0.0   0.01 -0.06 0.05     time (s), then where the tip is (m)
 *     1.5   0.01  0.06 0.05     in between it moves evenly
 *
 * All tissue within the radius of the tip is gone. Written are the way of the tip and what it took in each frame (CSV),
 * a picture of the end, and a series of skin and walls of the hole for ParaView; the same on every machine. Times of
 * calls are in a table of their own. Exit status: 0, 2 wrong usage or a file that cannot be read or written, 3 a step
 * failed or memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "cut_scene.h"
#include "options.h"

#include "cut_options.h"

#define REAL(x) ((sb_real)(x)) /* everything here computes in double, the body in sb_real */

static const char *const program_name = "cautery";
static const double gravity = 9.81; /* m/s^2 */
static const double density = 1060; /* kg/m^3 */
enum { MOST_LINE = 1024, MOST_PLACES = 1 << 20 };

typedef struct settings {
    cut_settings cut;
    const char *path, *write_path;
    double radius, speed, passes_apart, rest;
    int passes, frames;
} settings;

/* Where the tip is at a time. */
typedef struct place {
    double time;
    sb_vec3 tip;
} place;

/* What happened in a frame. */
typedef struct frame {
    double time, volume, mass, burn_ms, step_ms, draw_ms; /* volume (m^3), mass (kg): taken so far */
    sb_vec3 tip;
    int burns, is_on, cells, nodes, crumbs, parts;
} frame;

typedef struct work {
    const settings *set;
    cut_scene c;
    place *places;
    int place_count, place_room;
    frame *frames;
    int frame_count;
    double mass; /* of the whole organ (kg) */
} work;

/* ---- the organ ------------------------------------------------------------------------------------------------- */

static int make_mesh(work *w)
{
    const settings *s = w->set;
    organ *o = &w->c.scene;
    sb_error error;
    *o = organ_named(program_name);
    if (s->cut.organ) {
        int status = organ_load(o, s->cut.organ, s->cut.scale);
        return status ? status : organ_make_skin(o);
    }
    if (sb_mesh_organ(SB_TET4, s->cut.cells, NULL, &o->mesh, &error) != SB_OK)
        return organ_complain_of(o, "the organ", &error, ORGAN_USAGE);
    return organ_make_skin(o);
}

static int make_scene(work *w)
{
    const settings *s = w->set;
    organ *o = &w->c.scene;
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    int status;
    def.material = sb_material_corotated(REAL(s->cut.young), REAL(s->cut.poisson), REAL(density));
    def.gravity = sb_v3(0, 0, REAL(-gravity));
    def.damping_stiffness = REAL(0.02);
    status = cut_scene_make(&w->c, &def, s->cut.lattice, SB_CUT_LAG, 0);
    if (!status)
        status = organ_hold_on_table(o);
    if (status)
        return status;
    w->mass = (double)sb_body_mass(o->body);
    options.tolerance = REAL(1e-4);
    if (sb_body_solve_static(o->body, &options, &info) != SB_OK)
        return organ_complain_of(o, "the organ does not come to rest", &info.error, ORGAN_FAILED);
    return 0;
}

/* ---- the way of the tip ---------------------------------------------------------------------------------------- */

static int complain_line(const work *w, int line, const char *what)
{
    char where[ORGAN_PATH + 64];
    snprintf(where, sizeof where, "%s:%d", w->set->path, line);
    return organ_complain(&w->c.scene, where, what, ORGAN_USAGE);
}

/* 0: no memory. */
static int add_place(work *w, double time, sb_vec3 tip)
{
    if (w->place_count == w->place_room) {
        int room = 2 * w->place_room + 64;
        place *grown = room < MOST_PLACES ? (place *)realloc(w->places, (size_t)room * sizeof *grown) : NULL;
        if (!grown)
            return 0;
        w->places = grown;
        w->place_room = room;
    }
    w->places[w->place_count].time = time;
    w->places[w->place_count++].tip = tip;
    return 1;
}

/* Reads `time x y z`; says what is wrong, or NULL. */
static const char *read_place(const char *text, double numbers[4])
{
    int count = 0;
    for (;;) {
        char *end;
        double value;
        text += strspn(text, " \t\r\n");
        if (!*text || *text == '#')
            break;
        value = strtod(text, &end);
        if (count == 4 || end == text || !isfinite(value) || (*end && !strchr(" \t\r\n#", *end)))
            return "needs four finite numbers: the time, and where the tip is";
        numbers[count++] = value;
        text = end;
    }
    return count == 4 ? NULL : "needs four finite numbers: the time, and where the tip is";
}

static int read_path(work *w)
{
    char text[MOST_LINE];
    FILE *file = fopen(w->set->path, "r");
    int line = 0, status = 0, bad;
    if (!file)
        return organ_complain(&w->c.scene, w->set->path, "cannot be read", ORGAN_USAGE);
    while (!status && fgets(text, sizeof text, file)) {
        const char *at = text + strspn(text, " \t\r\n"), *wrong;
        double numbers[4];
        line++;
        if (!strchr(text, '\n') && strlen(text) == sizeof text - 1) {
            status = complain_line(w, line, "is longer than 1022 characters");
            continue;
        }
        if (!*at || *at == '#')
            continue;
        wrong = read_place(at, numbers);
        if (!wrong && numbers[0] < 0)
            wrong = "has a time below 0";
        if (!wrong && w->place_count && !(numbers[0] > w->places[w->place_count - 1].time))
            wrong = "needs a later time than the line before";
        if (wrong)
            status = complain_line(w, line, wrong);
        else if (!add_place(w, numbers[0], sb_v3(REAL(numbers[1]), REAL(numbers[2]), REAL(numbers[3]))))
            status = organ_complain_memory(&w->c.scene);
    }
    bad = ferror(file);
    fclose(file);
    if (!status && bad)
        return organ_complain(&w->c.scene, w->set->path, "cannot be read", ORGAN_USAGE);
    if (!status && w->place_count < 2)
        return organ_complain(&w->c.scene, w->set->path, "has fewer than two places of the tip", ORGAN_USAGE);
    return status;
}

/* To a micrometre, so that a file has the same numbers. */
static double rounded(double x) { return floor(1e6 * x + 0.5) / 1e6; }

/* To and fro over the middle, half a radius below the skin at rest, each pass a little lower than the one before. */
static int make_path(work *w)
{
    enum { PLACES = 17 };
    const settings *s = w->set;
    const organ *o = &w->c.scene;
    double x = rounded(0.5 * (double)(o->low.x + o->high.x)), reach = 0.3 * (double)(o->high.y - o->low.y);
    double middle = 0.5 * (double)(o->low.y + o->high.y), time = 0;
    for (int pass = 0; pass < s->passes; pass++)
        for (int k = 0; k < PLACES; k++) {
            double y = rounded(middle + reach * (pass % 2 ? 1 : -1) * (1 - 2.0 * k / (PLACES - 1)));
            sb_surface_hit hit;
            sb_vec3 tip;
            if (!sb_surface_ray(o->skin, sb_v3(REAL(x), REAL(y), 2 * o->high.z - o->low.z), sb_v3(0, 0, -1),
                                SB_REAL_MAX, &hit))
                continue;
            tip = sb_v3(REAL(x), REAL(y),
                        REAL(rounded((double)hit.point.z - s->radius * (0.5 + s->passes_apart * pass))));
            if (w->place_count)
                time += (double)sb_v3_norm(sb_v3_sub(tip, w->places[w->place_count - 1].tip)) / s->speed + 1e-6;
            time = rounded(time);
            if (!add_place(w, time, tip))
                return organ_complain_memory(o);
        }
    return w->place_count > 1 ? 0 : organ_complain(o, "the organ", "has nothing to burn in its middle", ORGAN_USAGE);
}

static int write_path(const work *w)
{
    sb_output out;
    if (sb_output_open(&out, w->set->write_path, NULL) != SB_OK)
        return organ_complain_file(&w->c.scene, w->set->write_path);
    fprintf(out.file, "# time (s), the tip (m)\n");
    for (int k = 0; k < w->place_count; k++)
        fprintf(out.file, "%.6f  %.6f %.6f %.6f\n", w->places[k].time, (double)w->places[k].tip.x,
                (double)w->places[k].tip.y, (double)w->places[k].tip.z);
    return sb_output_close(&out, NULL) == SB_OK ? 0 : organ_complain_file(&w->c.scene, w->set->write_path);
}

static int plan_path(work *w)
{
    double end;
    int status = w->set->path ? read_path(w) : make_path(w);
    if (!status && w->set->write_path)
        status = write_path(w);
    if (status)
        return status;
    end = fmin(1e5, ceil((w->places[w->place_count - 1].time + w->set->rest) * w->set->cut.rate));
    w->frame_count = w->set->frames > 0 ? w->set->frames : (int)fmax(1, end);
    w->frames = (frame *)calloc((size_t)w->frame_count, sizeof *w->frames);
    return w->frames ? 0 : organ_complain_memory(&w->c.scene);
}

static sb_vec3 tip_at(const work *w, double time)
{
    const place *p = w->places;
    double share;
    int k = 0;
    while (k + 2 < w->place_count && p[k + 1].time < time)
        k++;
    share = fmax(0, fmin(1, (time - p[k].time) / (p[k + 1].time - p[k].time)));
    return sb_v3_madd(p[k].tip, REAL(share), sb_v3_sub(p[k + 1].tip, p[k].tip));
}

/* ---- frames ---------------------------------------------------------------------------------------------------- */

/* Burns along the way of a frame, in balls that overlap. */
static int burn_along(work *w, double before, frame *f)
{
    const double apart = 0.25; /* of the radius */
    sb_vec3 from = tip_at(w, before);
    double way = (double)sb_v3_norm(sb_v3_sub(f->tip, from));
    sb_cut_info info;
    sb_error error;
    if (f->time <= w->places[0].time || before >= w->places[w->place_count - 1].time)
        return 0;
    f->is_on = 1;
    f->burns = (int)fmin(1000, ceil(way / (apart * w->set->radius)));
    f->burns = f->burns < 1 ? 1 : f->burns;
    for (int k = 1; k <= f->burns; k++) {
        sb_vec3 tip = sb_v3_madd(from, REAL((double)k / f->burns), sb_v3_sub(f->tip, from));
        if (sb_cut_ablate(w->c.cut, tip, REAL(w->set->radius), &info, &error) != SB_OK)
            return organ_complain_of(&w->c.scene, "the tip does not burn", &error, ORGAN_FAILED);
        f->volume += (double)info.removed_volume;
        f->mass += (double)info.removed_mass;
        f->cells += info.cells;
        f->nodes += info.nodes;
        f->crumbs += info.crumbs;
    }
    return 0;
}

static int run_frame(work *w, int i)
{
    frame *f = w->frames + i;
    double start = seconds_now();
    int status;
    if (i > 0)
        f->volume = f[-1].volume, f->mass = f[-1].mass;
    f->time = (i + 1) / w->set->cut.rate;
    f->tip = tip_at(w, f->time);
    status = burn_along(w, i / w->set->cut.rate, f);
    f->burn_ms = 1e3 * (seconds_now() - start);
    if (!status)
        status = organ_step(&w->c.scene, 1 / w->set->cut.rate);
    if (status)
        return status;
    f->step_ms = 1e3 * w->c.scene.seconds;
    start = seconds_now();
    status = cut_scene_look(&w->c);
    f->draw_ms = 1e3 * (seconds_now() - start);
    f->parts = w->c.part_count;
    if (!status && w->set->cut.every > 0 && (i + 1) % w->set->cut.every == 0)
        status = cut_scene_write_frame(&w->c, w->set->cut.out);
    return status;
}

static int run_frames(work *w)
{
    int status = 0;
    for (int i = 0; i < w->frame_count && !status; i++) {
        char words[64];
        status = run_frame(w, i);
        snprintf(words, sizeof words, "%.2f s, %.2f g gone", w->frames[i].time, 1e3 * w->frames[i].mass);
        progress_show((double)(i + 1) / w->frame_count, words);
    }
    progress_end();
    if (!status && w->c.scene.frames)
        status = organ_write_series(&w->c.scene, w->set->cut.out, w->set->cut.every / w->set->cut.rate);
    return status;
}

/* ---- what is written ------------------------------------------------------------------------------------------- */

static int write_table(work *w)
{
    char path[ORGAN_PATH + 32];
    sb_output out;
    snprintf(path, sizeof path, "%s.csv", w->set->cut.out);
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return organ_complain_file(&w->c.scene, path);
    fprintf(out.file, "time_s,on,tip_x_mm,tip_y_mm,tip_z_mm,removed_ml,removed_g,cells,nodes,crumbs,parts\n");
    for (int i = 0; i < w->frame_count; i++) {
        const frame *f = w->frames + i;
        fprintf(out.file, "%.6g,%d,%.4f,%.4f,%.4f,%.6g,%.6g,%d,%d,%d,%d\n", f->time, f->is_on, 1e3 * (double)f->tip.x,
                1e3 * (double)f->tip.y, 1e3 * (double)f->tip.z, 1e6 * f->volume, 1e3 * f->mass, f->cells, f->nodes,
                f->crumbs, f->parts);
    }
    return sb_output_close(&out, NULL) == SB_OK ? 0 : organ_complain_file(&w->c.scene, path);
}

static int write_times(work *w)
{
    char path[ORGAN_PATH + 32];
    sb_output out;
    snprintf(path, sizeof path, "%s_times.csv", w->set->cut.out);
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return organ_complain_file(&w->c.scene, path);
    fprintf(out.file, "time_s,burn_ms,step_ms,surface_ms\n");
    for (int i = 0; i < w->frame_count; i++)
        fprintf(out.file, "%.6g,%.3f,%.3f,%.3f\n", w->frames[i].time, w->frames[i].burn_ms, w->frames[i].step_ms,
                w->frames[i].draw_ms);
    return sb_output_close(&out, NULL) == SB_OK ? 0 : organ_complain_file(&w->c.scene, path);
}

static int draw_picture(work *w)
{
    const int width = 1280, height = 960;
    const frame *last = w->frames + w->frame_count - 1;
    char path[ORGAN_PATH + 32], title[128], details[200];
    picture p;
    picture_begin(&p, width, height);
    cut_scene_draw(&w->c, &p, NULL, 1);
    if (last->is_on) /* it is still at work */
        picture_add_capsule(&p, last->tip, sb_v3_add(last->tip, sb_v3(0, 0, REAL(8 * w->set->radius))),
                            0.4 * w->set->radius, picture_web(0x8d99a6));
    picture_render(&p, -26, 42);
    picture_length_bar(&p);
    snprintf(title, sizeof title, "%.2f g burnt in %.2f s", 1e3 * last->mass, last->time);
    snprintf(details, sizeof details, "%d tet4, radius %.3g mm, lattice %d", w->c.scene.mesh.element_count,
             1e3 * w->set->radius, w->set->cut.lattice);
    picture_text(&p, 0.06 * width, 0.075 * height, 22, PICTURE_LEFT, picture_ink(), title);
    picture_text(&p, 0.06 * width, 0.115 * height, 14, PICTURE_LEFT, picture_ink(), details);
    snprintf(path, sizeof path, "%s.png", w->set->cut.out);
    return organ_save_picture(&w->c.scene, &p, path);
}

/* Mean and worst of what `first` points to in the first frame, of frames in which the tip is on, or all. */
static void print_times(const work *w, const char *name, const double *first, int burning)
{
    double sum = 0, worst = 0;
    int count = 0;
    for (int i = 0; i < w->frame_count; i++) {
        double value = *(const double *)((const char *)first + (size_t)i * sizeof(frame));
        if (burning && !w->frames[i].is_on)
            continue;
        sum += value;
        worst = fmax(worst, value);
        count++;
    }
    printf("%-11s %.2f ms in the mean, %.2f ms at worst, of %d frames\n", name, count ? sum / count : 0, worst, count);
}

static int print_summary(work *w)
{
    const frame *last = w->frames + w->frame_count - 1;
    int cells = 0, nodes = 0, crumbs = 0, burns = 0;
    for (int i = 0; i < w->frame_count; i++) {
        cells += w->frames[i].cells;
        nodes += w->frames[i].nodes;
        crumbs += w->frames[i].crumbs;
        burns += w->frames[i].burns;
    }
    printf("organ       %s: %d nodes, %d tet4, %.1f g\n", w->set->cut.organ ? w->set->cut.organ : "like a liver",
           w->c.scene.mesh.node_count, w->c.scene.mesh.element_count, 1e3 * w->mass);
    printf("burnt       %.3f ml, %.3f g in %d balls of %.3g mm radius; %d crumbs among it\n", 1e6 * last->volume,
           1e3 * last->mass, burns, 1e3 * w->set->radius, crumbs);
    printf("left        %.3f g; %d cells and %d nodes more\n", 1e3 * (double)sb_body_mass(w->c.scene.body), cells,
           nodes);
    print_times(w, "burning", &w->frames[0].burn_ms, 1);
    print_times(w, "step", &w->frames[0].step_ms, 0);
    print_times(w, "surface", &w->frames[0].draw_ms, 0);
    cut_scene_print_parts(&w->c);
    printf("written     %s.csv, %s_times.csv, %s.png", w->set->cut.out, w->set->cut.out, w->set->cut.out);
    if (w->c.scene.frames)
        printf(", %s_0000.vtk to _%04d.vtk; ParaView opens %s.vtk.series", w->set->cut.out, w->c.scene.frames - 1,
               w->set->cut.out);
    printf("\nremoved_ml=%.4f removed_g=%.4f left_g=%.4f parts=%d frames=%d\n", 1e6 * last->volume, 1e3 * last->mass,
           1e3 * (double)sb_body_mass(w->c.scene.body), w->c.part_count, w->frame_count);
    return 0;
}

static int run(const settings *set)
{
    static int (*const stages[])(work *) = {make_mesh,   make_scene,  plan_path,    run_frames,
                                            write_table, write_times, draw_picture, print_summary};
    work w;
    int status = 0;
    memset(&w, 0, sizeof w);
    w.set = set;
    for (size_t i = 0; i < sizeof stages / sizeof stages[0] && !status; i++)
        status = stages[i](&w);
    cut_scene_free(&w.c);
    free(w.places);
    free(w.frames);
    return status;
}

/* ---- command line ---------------------------------------------------------------------------------------------- */

static settings default_settings(void)
{
    settings s;
    memset(&s, 0, sizeof s);
    s.cut = cut_settings_default(program_name);
    s.radius = 0.006;
    s.speed = 0.05;
    s.passes_apart = 0.7;
    s.rest = 0.2;
    s.cut.lattice = 4;
    s.passes = 3;
    return s;
}

enum { OPTION_COUNT = 9 }; /* of its own */
static int list_options(settings *s, option options[OPTION_COUNT + CUT_OPTION_COUNT])
{
    const option all[OPTION_COUNT] = {
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &s->cut.out, 0, 0, "files are NAME.csv, NAME_times.csv, NAME.png"},
        {"--path", "FILE", OPTION_TEXT, NULL, NULL, &s->path, 0, 0, "way of the tip; without it one is made"},
        {"--write-path", "FILE", OPTION_TEXT, NULL, NULL, &s->write_path, 0, 0, "writes the way, to be edited"},
        {"--radius", "M", OPTION_NUMBER, NULL, &s->radius, NULL, 1e-5, 1, "that the tip burns to (m)"},
        {"--frames", "N", OPTION_INTEGER, &s->frames, NULL, NULL, 0, 100000,
         "how many; 0 (default): to the end of the way, and --rest"},
        {"--rest", "S", OPTION_NUMBER, NULL, &s->rest, NULL, 0, 100, "time after the way (s)"},
        {"--passes", "N", OPTION_INTEGER, &s->passes, NULL, NULL, 1, 1000, "of the way that is made, to and fro"},
        {"--apart", "SHARE", OPTION_NUMBER, NULL, &s->passes_apart, NULL, 0, 10,
         "of the radius that each pass is lower than the one before"},
        {"--speed", "M/S", OPTION_NUMBER, NULL, &s->speed, NULL, 1e-4, 10, "of its tip"},
    };
    memcpy(options, all, sizeof all);
    return cut_options_add(&s->cut, options, OPTION_COUNT, "taken out");
}

static int check_settings(const settings *s)
{
    return cut_settings_check(program_name, &s->cut) && organ_check_name(program_name, "--path", s->path);
}

static int program(int argc, char **argv)
{
    settings s = default_settings();
    option options[OPTION_COUNT + CUT_OPTION_COUNT];
    int count = list_options(&s, options);
    if (!options_parse(program_name, options, count, &s.cut.organ, 1, argc, argv))
        return ORGAN_USAGE;
    if (s.cut.help) {
        s = default_settings();
        list_options(&s, options);
        printf("usage: cautery [ORGAN] [OPTIONS]\n\n"
               "The tip of a cautery burns its way through an organ, and what it takes is weighed. ORGAN: a mesh of\n"
               "tet4 in metres (VTK, VTU, gmsh, Medit or TetGen); without it one like a liver is made.\n\n");
        options_print(options, count);
        printf(
            "\nA file with a way has lines of a time (s) and where the tip is (x y z, m), with later and later times;\n"
            "# begins a comment. The last line: what was taken, what is left of the organ, and its parts.\n");
        return 0;
    }
    return check_settings(&s) ? run(&s) : ORGAN_USAGE;
}

int main(int argc, char **argv) { return finish(program_name, program(argc, argv), ORGAN_USAGE); }
