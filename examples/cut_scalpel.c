/* cut_scalpel: a blade cuts an organ frame by frame, and the cut opens under the organ's weight.
 *
 *     cut_scalpel [ORGAN] [OPTIONS]      cut_scalpel --help lists the options
 *
 * Without a file an organ like a liver is made. It lies on a ridge below its middle and hangs down on both sides; a
 * blade goes across it above the ridge, from the front to the back, or along strokes that a file has:
 *
 *     # comment
 *     stroke                                  begins a stroke
 *     0.0   0.01 -0.06 0.05   0.01 -0.06 0.09   time (s), then 2 to 8 corners of the blade's edge (m)
 *     1.5   0.01  0.06 0.05   0.01  0.06 0.09   in between it moves evenly
 *
 * Written are what happened in each frame (CSV), a picture of the end, and a series of skin and lips for ParaView; the
 * same on every machine. Times of calls are in a table of their own. Exit status: 0, 2 wrong usage or a file that
 * cannot be read or written, 3 a step failed or memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "cut_scene.h"
#include "options.h"

#include "cut_options.h"

#define REAL(x) ((sb_real)(x)) /* everything here computes in double, the body in sb_real */

static const char *const program_name = "cut_scalpel";
static const double gravity = 9.81; /* m/s^2 */
static const double density = 1060; /* kg/m^3 */
enum { MOST_STROKES = 64, MOST_CORNERS = 8, MOST_LINE = 1024 };

typedef struct settings {
    cut_settings cut;
    const char *stroke, *write_stroke;
    double depth, speed, ridge, rest;
    int frames;
} settings;

/* Where a blade is at a time. */
typedef struct pose {
    double time;
    sb_vec3 edge[MOST_CORNERS];
} pose;

typedef struct stroke {
    int first, count, corners; /* its poses */
    int number;                /* of the cut while it is under way, or -1 */
} stroke;

/* What happened in a frame. */
typedef struct frame {
    sb_cut_info info; /* of all its moves */
    double time, gape, kinetic, move_ms, step_ms, draw_ms;
} frame;

typedef struct work {
    const settings *set;
    cut_scene c;
    pose *poses;
    int pose_count, pose_room;
    stroke strokes[MOST_STROKES];
    int stroke_count;
    frame *frames;
    int frame_count;
} work;

/* ---- the organ ------------------------------------------------------------------------------------------------- */

static int make_mesh(work *w)
{
    const settings *s = w->set;
    organ *o = &w->c.scene;
    sb_error error;
    int status = 0;
    *o = organ_named(program_name);
    if (s->cut.organ)
        status = organ_load(o, s->cut.organ, s->cut.scale);
    else if (sb_mesh_organ(SB_TET4, s->cut.cells, NULL, &o->mesh, &error) != SB_OK)
        status = organ_complain_of(o, "the organ", &error, ORGAN_USAGE);
    if (!status)
        status = cut_scene_raise(&w->c, s->cut.quadratic);
    return status ? status : organ_make_skin(o);
}

static int make_scene(work *w)
{
    const settings *s = w->set;
    organ *o = &w->c.scene;
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    double middle = 0.5 * (double)(o->low.x + o->high.x), half = 0.5 * s->ridge * (double)(o->high.x - o->low.x);
    int status;
    def.material = sb_material_corotated(REAL(s->cut.young), REAL(s->cut.poisson), REAL(density));
    def.gravity = sb_v3(0, 0, REAL(-gravity));
    def.damping_stiffness = REAL(0.02);
    status = cut_scene_make(&w->c, &def, s->cut.lattice, cut_settings_front(&s->cut), MOST_STROKES);
    if (!status)
        status = organ_hold_below(o, middle - half, middle + half,
                                  "has no node on its underside in the middle to lie on (try a wider --ridge)");
    if (status)
        return status;
    options.tolerance = REAL(1e-4);
    if (sb_body_solve_static(o->body, &options, &info) != SB_OK)
        return organ_complain_of(o, "the organ does not come to rest on its ridge", &info.error, ORGAN_FAILED);
    return 0;
}

/* ---- the blade's way ------------------------------------------------------------------------------------------- */

static int complain_line(const work *w, int line, const char *what)
{
    char place[ORGAN_PATH + 64];
    snprintf(place, sizeof place, "%s:%d", w->set->stroke, line);
    return organ_complain(&w->c.scene, place, what, ORGAN_USAGE);
}

static int begin_stroke(work *w)
{
    stroke *s = w->strokes + w->stroke_count;
    if (w->stroke_count == MOST_STROKES)
        return 0;
    s->first = w->pose_count;
    s->count = s->corners = 0;
    s->number = -1;
    w->stroke_count++;
    return 1;
}

/* Adds a pose to the stroke begun last; 0: no memory. */
static int add_pose(work *w, const pose *p, int corners)
{
    stroke *s = w->strokes + w->stroke_count - 1;
    if (w->pose_count == w->pose_room) {
        int room = 2 * w->pose_room + 64;
        pose *grown = room < 1 << 24 ? (pose *)realloc(w->poses, (size_t)room * sizeof *grown) : NULL;
        if (!grown)
            return 0;
        w->poses = grown;
        w->pose_room = room;
    }
    w->poses[w->pose_count++] = *p;
    s->corners = corners;
    s->count++;
    return 1;
}

/* Reads `time x y z x y z ...`; says what is wrong, or NULL. */
static const char *read_pose(const char *text, pose *p, int *corners)
{
    double numbers[1 + 3 * MOST_CORNERS];
    int count = 0;
    for (;;) {
        char *end;
        double value;
        text += strspn(text, " \t\r\n");
        if (!*text || *text == '#')
            break;
        value = strtod(text, &end);
        if (end == text || !isfinite(value) || (*end && !strchr(" \t\r\n#", *end)))
            return "needs finite numbers: the time, and three for each corner of the edge";
        if (count == 1 + 3 * MOST_CORNERS)
            return "has more than 8 corners";
        numbers[count++] = value;
        text = end;
    }
    if (count < 7 || count % 3 != 1)
        return "needs the time and three numbers for each of 2 to 8 corners";
    *corners = count / 3;
    p->time = numbers[0];
    for (int k = 0; k < *corners; k++)
        p->edge[k] = sb_v3(REAL(numbers[3 * k + 1]), REAL(numbers[3 * k + 2]), REAL(numbers[3 * k + 3]));
    return NULL;
}

/* A line of the file of strokes that is not empty. */
static int take_line(work *w, const char *text, int line)
{
    stroke *s = w->stroke_count ? w->strokes + w->stroke_count - 1 : NULL;
    const char *wrong;
    int corners;
    pose p;
    if (strncmp(text, "stroke", 6) == 0) {
        size_t end = 6 + strspn(text + 6, " \t\r\n");
        if (text[end] && text[end] != '#')
            return complain_line(w, line, "`stroke` stands alone");
        if (s && s->count < 2)
            return complain_line(w, line, "the stroke before has fewer than two places of the blade");
        return begin_stroke(w) ? 0 : complain_line(w, line, "is the 65th stroke; there can be 64");
    }
    memset(&p, 0, sizeof p);
    wrong = read_pose(text, &p, &corners);
    if (!wrong && !s)
        wrong = "stands before the first line `stroke`";
    if (!wrong && s->count && corners != s->corners)
        wrong = "has another number of corners than the line before";
    if (!wrong && p.time < 0)
        wrong = "has a time below 0";
    if (!wrong && s->count && !(p.time > w->poses[w->pose_count - 1].time))
        wrong = "needs a later time than the line before";
    if (wrong)
        return complain_line(w, line, wrong);
    return add_pose(w, &p, corners) ? 0 : organ_complain_memory(&w->c.scene);
}

static int read_strokes(work *w)
{
    char text[MOST_LINE];
    FILE *file = fopen(w->set->stroke, "r");
    int line = 0, status = 0, bad;
    if (!file)
        return organ_complain(&w->c.scene, w->set->stroke, "cannot be read", ORGAN_USAGE);
    while (!status && fgets(text, sizeof text, file)) {
        const char *at = text + strspn(text, " \t\r\n");
        line++;
        if (!strchr(text, '\n') && strlen(text) == sizeof text - 1)
            status = complain_line(w, line, "is longer than 1022 characters");
        else if (*at && *at != '#')
            status = take_line(w, at, line);
    }
    bad = ferror(file);
    fclose(file);
    if (!status && bad)
        return organ_complain(&w->c.scene, w->set->stroke, "cannot be read", ORGAN_USAGE);
    if (!status && w->stroke_count == 0)
        return organ_complain(&w->c.scene, w->set->stroke, "has no stroke", ORGAN_USAGE);
    if (!status && w->strokes[w->stroke_count - 1].count < 2)
        return complain_line(w, line, "the stroke before has fewer than two places of the blade");
    return status;
}

/* To a micrometre, so that a file has the same numbers. */
static double rounded(double x) { return floor(1e6 * x + 0.5) / 1e6; }

/* The skin above and below (x, y), where the organ is now; 0: nothing is there. */
static int look_through(const sb_surface *skin, const sb_mesh *now, double x, double y, double *bottom, double *top)
{
    sb_vec3 low, high;
    sb_surface_hit hit;
    sb_mesh_bounds(now, &low, &high);
    if (!sb_surface_ray(skin, sb_v3(REAL(x), REAL(y), 2 * high.z - low.z), sb_v3(0, 0, -1), SB_REAL_MAX, &hit))
        return 0;
    *top = (double)hit.point.z;
    if (!sb_surface_ray(skin, sb_v3(REAL(x), REAL(y), 2 * low.z - high.z), sb_v3(0, 0, 1), SB_REAL_MAX, &hit))
        return 0;
    *bottom = (double)hit.point.z;
    return 1;
}

/* One stroke across the middle: the tip at --depth of the organ's thickness, slanted as a hand holds it. Before and
 * behind the organ it stays as deep as at its rim. */
static int make_stroke(work *w)
{
    enum { PLACES = 33 };
    const settings *s = w->set;
    const organ *o = &w->c.scene;
    sb_mesh now = o->boundary.surface;
    sb_surface *skin = NULL;
    sb_vec3 low, high;
    sb_error error;
    const double slant = 0.5; /* the heel is that far behind the tip, for each metre that it is higher */
    double tips[PLACES], ys[PLACES], x, margin, heel = 0, clear, way;
    int first = -1, last = -1;
    for (int i = 0; i < now.node_count; i++)
        o->places[i] = sb_body_positions(o->body)[o->boundary.nodes[i]];
    now.nodes = o->places;
    if (sb_surface_create(&now, NULL, &skin, &error) != SB_OK)
        return organ_complain_of(o, "the organ", &error, ORGAN_FAILED);
    sb_mesh_bounds(&now, &low, &high);
    x = rounded(0.5 * (double)(o->low.x + o->high.x));
    margin = 0.05 * (double)(high.y - low.y);
    clear = 0.1 * (double)(high.z - low.z);
    way = (double)(high.y - low.y) + 2 * margin + slant * ((double)(high.z - low.z) + 2 * clear);
    for (int k = 0; k < PLACES; k++) {
        double bottom, top;
        ys[k] = (double)low.y - margin + k * way / (PLACES - 1);
        if (!look_through(skin, &now, x, ys[k], &bottom, &top))
            continue;
        tips[k] = s->depth < 1 ? top - s->depth * (top - bottom) : (double)low.z - clear;
        heel = first < 0 ? top : fmax(heel, top);
        first = first < 0 ? k : first;
        last = k;
    }
    sb_surface_destroy(skin);
    if (first < 0)
        return organ_complain(o, "the organ", "has nothing to cut in its middle", ORGAN_USAGE);
    begin_stroke(w);
    for (int k = 0; k < PLACES; k++) {
        double z = tips[k < first ? first : k > last ? last : k];
        pose p;
        memset(&p, 0, sizeof p);
        p.time = rounded((ys[k] - ys[0]) / s->speed);
        p.edge[0] = sb_v3(REAL(x), REAL(rounded(ys[k])), REAL(rounded(z)));
        p.edge[1] = sb_v3(REAL(x), REAL(rounded(ys[k] - slant * (heel + clear - z))), REAL(rounded(heel + clear)));
        if (!add_pose(w, &p, 2))
            return organ_complain_memory(o);
    }
    return 0;
}

static int write_strokes(const work *w)
{
    sb_output out;
    if (sb_output_open(&out, w->set->write_stroke, NULL) != SB_OK)
        return organ_complain_file(&w->c.scene, w->set->write_stroke);
    fprintf(out.file, "# time (s), corners of the blade's edge (m)\n");
    for (int i = 0; i < w->stroke_count; i++) {
        fprintf(out.file, "stroke\n");
        for (int k = w->strokes[i].first; k < w->strokes[i].first + w->strokes[i].count; k++) {
            fprintf(out.file, "%.6f", w->poses[k].time);
            for (int a = 0; a < w->strokes[i].corners; a++)
                fprintf(out.file, "  %.6f %.6f %.6f", (double)w->poses[k].edge[a].x, (double)w->poses[k].edge[a].y,
                        (double)w->poses[k].edge[a].z);
            fprintf(out.file, "\n");
        }
    }
    return sb_output_close(&out, NULL) == SB_OK ? 0 : organ_complain_file(&w->c.scene, w->set->write_stroke);
}

static int plan_strokes(work *w)
{
    double end = 0;
    int status = w->set->stroke ? read_strokes(w) : make_stroke(w);
    if (!status && w->set->write_stroke)
        status = write_strokes(w);
    if (status)
        return status;
    for (int i = 0; i < w->stroke_count; i++)
        end = fmax(end, w->poses[w->strokes[i].first + w->strokes[i].count - 1].time);
    end = fmin(1e5, ceil((end + w->set->rest) * w->set->cut.rate));
    w->frame_count = w->set->frames > 0 ? w->set->frames : (int)fmax(1, end);
    w->frames = (frame *)calloc((size_t)w->frame_count, sizeof *w->frames);
    return w->frames ? 0 : organ_complain_memory(&w->c.scene);
}

/* Where the blade of a stroke is, before its first and after its last place there. */
static void place_blade(const work *w, const stroke *s, double time, sb_vec3 *edge)
{
    const pose *p = w->poses + s->first;
    double share;
    int k = 0;
    while (k + 2 < s->count && p[k + 1].time < time)
        k++;
    share = fmax(0, fmin(1, (time - p[k].time) / (p[k + 1].time - p[k].time)));
    for (int a = 0; a < s->corners; a++)
        edge[a] = sb_v3_madd(p[k].edge[a], REAL(share), sb_v3_sub(p[k + 1].edge[a], p[k].edge[a]));
}

/* ---- frames ---------------------------------------------------------------------------------------------------- */

static int move_stroke(work *w, stroke *s, double before, double now, frame *f)
{
    const pose *p = w->poses + s->first;
    sb_vec3 edge[MOST_CORNERS];
    sb_cut_info info;
    sb_error error;
    if (now <= p[0].time || before >= p[s->count - 1].time)
        return 0;
    if (s->number < 0) {
        place_blade(w, s, before, edge);
        if (sb_cut_begin(w->c.cut, edge, s->corners, &s->number, &error) != SB_OK)
            return organ_complain_of(&w->c.scene, "the stroke does not begin", &error, ORGAN_FAILED);
    }
    place_blade(w, s, now, edge);
    if (sb_cut_move(w->c.cut, s->number, edge, &info, &error) != SB_OK)
        return organ_complain_of(&w->c.scene, "the blade does not move", &error, ORGAN_FAILED);
    f->info.links += info.links;
    f->info.ringed += info.ringed;
    f->info.cells += info.cells;
    f->info.nodes += info.nodes;
    if (now >= p[s->count - 1].time) {
        sb_cut_end(w->c.cut, s->number);
        s->number = -1;
    }
    return 0;
}

static int run_frame(work *w, int i)
{
    frame *f = w->frames + i;
    double before = i / w->set->cut.rate, start = seconds_now();
    sb_energy energy;
    int status = 0;
    f->time = (i + 1) / w->set->cut.rate;
    for (int k = 0; k < w->stroke_count && !status; k++)
        status = move_stroke(w, w->strokes + k, before, f->time, f);
    f->move_ms = 1e3 * (seconds_now() - start);
    if (!status)
        status = organ_step(&w->c.scene, 1 / w->set->cut.rate);
    if (status)
        return status;
    f->step_ms = 1e3 * w->c.scene.seconds;
    start = seconds_now();
    status = cut_scene_look(&w->c);
    f->draw_ms = 1e3 * (seconds_now() - start);
    f->info.parts = w->c.part_count;
    f->gape = cut_scene_gape(&w->c);
    if (sb_body_energy(w->c.scene.body, &energy) == SB_OK)
        f->kinetic = (double)energy.kinetic;
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
        snprintf(words, sizeof words, "%.2f s, open by %.1f mm", w->frames[i].time, 1e3 * w->frames[i].gape);
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
    fprintf(out.file, "time_s,links,ringed,cells,nodes,parts,gape_mm,kinetic_J\n");
    for (int i = 0; i < w->frame_count; i++) {
        const frame *f = w->frames + i;
        fprintf(out.file, "%.6g,%d,%d,%d,%d,%d,%.4g,%.6g\n", f->time, f->info.links, f->info.ringed, f->info.cells,
                f->info.nodes, f->info.parts, 1e3 * f->gape, f->kinetic);
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
    fprintf(out.file, "time_s,move_ms,step_ms,surface_ms\n");
    for (int i = 0; i < w->frame_count; i++)
        fprintf(out.file, "%.6g,%.3f,%.3f,%.3f\n", w->frames[i].time, w->frames[i].move_ms, w->frames[i].step_ms,
                w->frames[i].draw_ms);
    return sb_output_close(&out, NULL) == SB_OK ? 0 : organ_complain_file(&w->c.scene, path);
}

/* Blades that are in the tissue at the end. */
static void draw_blades(work *w, picture *p)
{
    double now = w->frames[w->frame_count - 1].time;
    for (int i = 0; i < w->stroke_count; i++) {
        sb_vec3 edge[MOST_CORNERS];
        if (w->strokes[i].number < 0)
            continue;
        place_blade(w, w->strokes + i, now, edge);
        for (int a = 0; a + 1 < w->strokes[i].corners; a++)
            picture_add_capsule(p, edge[a], edge[a + 1], 1e-3, picture_web(0x8d99a6));
    }
}

static int draw_picture(work *w)
{
    const int width = 1280, height = 960;
    const frame *last = w->frames + w->frame_count - 1;
    char path[ORGAN_PATH + 32], title[128], details[200];
    picture p;
    picture_begin(&p, width, height);
    cut_scene_draw(&w->c, &p, NULL, 1);
    draw_blades(w, &p);
    picture_render(&p, -26, 36);
    picture_length_bar(&p);
    snprintf(title, sizeof title, "Cut open by %.1f mm after %.2f s", 1e3 * last->gape, last->time);
    snprintf(details, sizeof details, "%d %s, E %.4g kPa, nu %.3g, lattice %d", w->c.scene.mesh.element_count,
             sb_element_name(w->c.scene.mesh.element_type), 1e-3 * w->set->cut.young, w->set->cut.poisson,
             w->set->cut.lattice);
    picture_text(&p, 0.06 * width, 0.075 * height, 22, PICTURE_LEFT, picture_ink(), title);
    picture_text(&p, 0.06 * width, 0.115 * height, 14, PICTURE_LEFT, picture_ink(), details);
    snprintf(path, sizeof path, "%s.png", w->set->cut.out);
    return organ_save_picture(&w->c.scene, &p, path);
}

/* Mean and worst of what `at` points to in the first frame; only frames that cut: all others 0. */
static void print_times(const work *w, const char *name, const double *first, int cutting)
{
    double sum = 0, worst = 0;
    int count = 0;
    for (int i = 0; i < w->frame_count; i++) {
        double value = *(const double *)((const char *)first + (size_t)i * sizeof(frame));
        if (cutting && w->frames[i].info.links == 0)
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
    sb_cut_info sum;
    memset(&sum, 0, sizeof sum);
    for (int i = 0; i < w->frame_count; i++) {
        sum.links += w->frames[i].info.links;
        sum.ringed += w->frames[i].info.ringed;
        sum.cells += w->frames[i].info.cells;
        sum.nodes += w->frames[i].info.nodes;
    }
    printf("organ       %s: %d nodes, %d %s, E %.4g Pa\n", w->set->cut.organ ? w->set->cut.organ : "like a liver",
           w->c.scene.mesh.node_count, w->c.scene.mesh.element_count, sb_element_name(w->c.scene.mesh.element_type),
           w->set->cut.young);
    printf("cut         %d links (%d by the rule of rings), %d cells and %d nodes more\n", sum.links, sum.ringed,
           sum.cells, sum.nodes);
    print_times(w, "cutting", &w->frames[0].move_ms, 1);
    print_times(w, "step", &w->frames[0].step_ms, 0);
    print_times(w, "surface", &w->frames[0].draw_ms, 0);
    cut_scene_print_parts(&w->c);
    printf("written     %s.csv, %s_times.csv, %s.png", w->set->cut.out, w->set->cut.out, w->set->cut.out);
    if (w->c.scene.frames)
        printf(", %s_0000.vtk to _%04d.vtk; ParaView opens %s.vtk.series", w->set->cut.out, w->c.scene.frames - 1,
               w->set->cut.out);
    printf("\nparts=%d gape_mm=%.2f links=%d cells=%d nodes=%d frames=%d\n", w->c.part_count, 1e3 * last->gape,
           sum.links, sum.cells, sum.nodes, w->frame_count);
    return 0;
}

static int run(const settings *set)
{
    static int (*const stages[])(work *) = {make_mesh,   make_scene,  plan_strokes, run_frames,
                                            write_table, write_times, draw_picture, print_summary};
    work w;
    int status = 0;
    memset(&w, 0, sizeof w);
    w.set = set;
    for (size_t i = 0; i < sizeof stages / sizeof stages[0] && !status; i++)
        status = stages[i](&w);
    cut_scene_free(&w.c);
    free(w.poses);
    free(w.frames);
    return status;
}

/* ---- command line ---------------------------------------------------------------------------------------------- */

static settings default_settings(void)
{
    settings s;
    memset(&s, 0, sizeof s);
    s.cut = cut_settings_default(program_name);
    s.cut.front = "lag";
    s.depth = 0.6;
    s.speed = 0.15;
    s.ridge = 0.25;
    s.rest = 0.8;
    s.cut.cells = 10;
    return s;
}

enum { OPTION_COUNT = 8 }; /* of its own */
static int list_options(settings *s, option options[OPTION_COUNT + CUT_OPTION_COUNT])
{
    const option all[OPTION_COUNT] = {
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &s->cut.out, 0, 0, "files are NAME.csv, NAME_times.csv, NAME.png"},
        {"--stroke", "FILE", OPTION_TEXT, NULL, NULL, &s->stroke, 0, 0, "strokes of the blade; without it one is made"},
        {"--write-stroke", "FILE", OPTION_TEXT, NULL, NULL, &s->write_stroke, 0, 0, "writes the strokes, to be edited"},
        {"--frames", "N", OPTION_INTEGER, &s->frames, NULL, NULL, 0, 100000,
         "how many; 0 (default): to the end of the strokes, and --rest"},
        {"--rest", "S", OPTION_NUMBER, NULL, &s->rest, NULL, 0, 100, "time after the last stroke (s)"},
        {"--ridge", "SHARE", OPTION_NUMBER, NULL, &s->ridge, NULL, 0.01, 1, "of the organ's width that it lies on"},
        {"--depth", "SHARE", OPTION_NUMBER, NULL, &s->depth, NULL, 0.01, 1,
         "of the thickness that the stroke made is deep; 1: through"},
        {"--speed", "M/S", OPTION_NUMBER, NULL, &s->speed, NULL, 1e-3, 10, "of its blade"},
    };
    memcpy(options, all, sizeof all);
    return cut_options_add(&s->cut, options, OPTION_COUNT, "cut apart");
}

static int check_settings(const settings *s)
{
    return cut_settings_check(program_name, &s->cut) && organ_check_name(program_name, "--stroke", s->stroke);
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
        printf(
            "usage: cut_scalpel [ORGAN] [OPTIONS]\n\n"
            "A blade cuts an organ frame by frame, and the cut opens under its weight. ORGAN: a mesh of tet4 or tet10 "
            "in\n"
            "metres (VTK, VTU, gmsh, Medit or TetGen); without it one like a liver is made. It lies on a ridge.\n\n");
        options_print(options, count);
        printf(
            "\nA file of strokes has lines `stroke`, each followed by lines of a time (s) and 2 to 8 corners of the\n"
            "blade's edge (x y z each, m), with later and later times; # begins a comment.\n"
            "The last line: parts at the end, how far points that were one are apart at most, and what was cut.\n");
        return 0;
    }
    return check_settings(&s) ? run(&s) : ORGAN_USAGE;
}

int main(int argc, char **argv) { return finish(program_name, program(argc, argv), ORGAN_USAGE); }
