/* cut_force: what a hand feels of cutting: force over the blade's way, for pushing, slicing and scissors.
 *
 *     cut_force [OPTIONS]      cut_force --help lists them
 *
 * A block of tissue lies on a table. A blade as long as the block is wide comes down through it: once straight, once
 * drawn along itself by --slice times as much as it goes down, and once straight through tissue of half the toughness.
 * --scissors closes a pair of scissors across the block instead. The block is held still, so that the chart shows the
 * law; with --steps it is stepped after each frame, feels the opposite of what the hand does, and gives way to it.
 *
 * Written are the numbers of each frame (CSV) and a chart (SVG); the same on every machine. Exit status: 0, 2 wrong
 * usage or a file that cannot be written, 3 a step failed or memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "options.h"
#include "plot.h"

#define REAL(x) ((sb_real)(x)) /* everything here computes in double, the body in sb_real */

static const char *const program_name = "cut_force";
static const double width = 0.06, breadth = 0.04, height = 0.05; /* of the block along x, y and z (m) */
static const double clear = 0.005;                               /* the blade begins so far above it (m) */
enum { USAGE = 2, FAILED = 3, RUNS = 3, MOST_PATH = 900 };

typedef struct settings {
    const char *out, *front;
    double toughness, slice, speed, rate, depth, young, poisson;
    int cells, lattice, scissors, steps, help;
} settings;

/* One cut: what the hand feels in each frame. */
typedef struct cut_run {
    const char *name;
    char label[96];
    double toughness, slice;
    double *way, *across, *along, *work, *area; /* [frames] mm, N, N, J, mm^2; of scissors way is the angle (degrees)
                                                 * and across the moment of closing (mN m) */
    int frames;
    double owed; /* at the end (J) */
} cut_run;

static int complain(const char *about, const char *what, int status)
{
    fprintf(stderr, "%s: %s: %s\n", program_name, about, what);
    return status;
}

/* ---- the block ------------------------------------------------------------------------------------------------- */

typedef struct scene {
    sb_mesh mesh;
    sb_body *body;
    sb_cut *cut;
    int stroke;
} scene;

static void free_scene(scene *s)
{
    sb_cut_destroy(s->cut);
    sb_body_destroy(s->body);
    sb_mesh_free(&s->mesh);
}

static int make_scene(const settings *set, double toughness, scene *s)
{
    sb_body_def def = sb_default_body_def();
    sb_cut_def cut_def = sb_default_cut_def();
    sb_error error;
    int n = set->cells;
    double young = set->steps ? set->young : 100 * set->young; /* what is held still is not dragged along */
    memset(s, 0, sizeof *s);
    if (sb_mesh_beam(SB_TET4, n + n / 5, n * 4 / 5, n, sb_v3(REAL(width), REAL(breadth), REAL(height)), NULL, &s->mesh,
                     &error) != SB_OK)
        return complain("the block", error.message, FAILED);
    def.mesh = &s->mesh;
    def.material = sb_material_corotated(REAL(young), REAL(set->poisson), 1060);
    def.damping_stiffness = REAL(0.02);
    def.slack = 1;
    if (sb_body_create(&def, &s->body, &error) != SB_OK)
        return complain("the block", error.message, FAILED);
    for (int i = 0; i < s->mesh.node_count; i++)
        if (s->mesh.nodes[i].z < REAL(1e-9) && sb_body_hold(s->body, &i, 1, SB_XYZ, &error) != SB_OK)
            return complain("the table", error.message, FAILED);
    cut_def.body = s->body;
    cut_def.lattice = set->lattice;
    cut_def.front = strcmp(set->front, "glue") == 0 ? SB_CUT_GLUE : SB_CUT_LAG;
    cut_def.toughness = REAL(toughness);
    return sb_cut_create(&cut_def, &s->cut, &error) == SB_OK ? 0 : complain("the cut", error.message, FAILED);
}

/* ---- tools ----------------------------------------------------------------------------------------------------- */

static const double open_angle = 0.9; /* of each blade of the scissors to their middle at the beginning (rad) */

static double path_length(const settings *set) { return set->scissors ? open_angle : clear + set->depth * height; }

/* The edge of the blade, or tip, hinge and tip, after so much of the way (m, or rad of each blade). */
static int place_tool(const settings *set, double slice, double way, sb_vec3 edge[3])
{
    const double x = 0.5031 * width, margin = 0.01; /* off the mesh's own planes */
    if (set->scissors) {
        double angle = open_angle - way, c = 0.1 * cos(angle), s = 0.1 * sin(angle), y = -0.02, z = 0.6 * height;
        edge[0] = sb_v3(REAL(x), REAL(y + c), REAL(z + s));
        edge[1] = sb_v3(REAL(x), REAL(y), REAL(z));
        edge[2] = sb_v3(REAL(x), REAL(y + c), REAL(z - s));
        return 3;
    }
    edge[0] = sb_v3(REAL(x), REAL(-margin - slice * way), REAL(height + clear - way));
    edge[1] = edge[0];
    edge[1].y += REAL(breadth + 2 * margin + slice * path_length(set));
    return 2;
}

static int move_tool(const settings *set, const cut_run *run, scene *s, double way, sb_cut_info *info)
{
    sb_vec3 edge[3], tips[2];
    sb_error error;
    sb_result result;
    place_tool(set, run->slice, way, edge);
    tips[0] = edge[0], tips[1] = edge[2];
    result = set->scissors ? sb_cut_scissors(s->cut, s->stroke, edge[1], tips, info, &error)
                           : sb_cut_move(s->cut, s->stroke, edge, info, &error);
    return result == SB_OK ? 0 : complain("the tool does not move", error.message, FAILED);
}

/* ---- a cut ----------------------------------------------------------------------------------------------------- */

static int take_frames(const settings *set, cut_run *run)
{
    double pace = set->scissors ? set->speed / 0.1 : set->speed; /* m/s, or rad/s of each blade */
    run->frames = (int)fmax(1, ceil(path_length(set) / pace * set->rate));
    run->way = (double *)calloc(5 * (size_t)run->frames, sizeof(double));
    run->across = run->way + run->frames;
    run->along = run->across + run->frames;
    run->work = run->along + run->frames;
    run->area = run->work + run->frames;
    return run->way ? 0 : complain("memory", "is short", FAILED);
}

static void note_frame(const settings *set, cut_run *run, int i, double step, const sb_cut_info *info)
{
    double before = i ? run->work[i - 1] : 0, area = i ? run->area[i - 1] : 0;
    run->way[i] = set->scissors ? (i + 1) * step * 2 * 57.29577951308232 : 1e3 * ((i + 1) * step - clear);
    run->across[i] = set->scissors ? 1e3 * (double)info->work / (2 * step) : (double)info->force.z;
    run->along[i] = set->scissors ? 0 : (double)info->force.y;
    run->work[i] = before + (double)info->work;
    run->area[i] = area + 1e6 * (double)info->released_area;
    run->owed = (double)info->owed;
}

static int cut_through(const settings *set, cut_run *run)
{
    scene s;
    sb_vec3 edge[3];
    sb_error error;
    int status = take_frames(set, run);
    double step = path_length(set) / run->frames;
    if (!status)
        status = make_scene(set, run->toughness, &s);
    else
        return status;
    if (!status && sb_cut_begin(s.cut, edge, place_tool(set, run->slice, 0, edge), &s.stroke, &error) != SB_OK)
        status = complain("the stroke does not begin", error.message, FAILED);
    for (int i = 0; i < run->frames && !status; i++) {
        sb_cut_info info;
        sb_step_info of_step;
        status = move_tool(set, run, &s, (i + 1) * step, &info);
        if (status)
            break;
        note_frame(set, run, i, step, &info);
        if (set->steps && sb_body_step(s.body, REAL(1 / set->rate), &of_step) != SB_OK)
            status = complain("a step failed", of_step.error.message, FAILED);
    }
    free_scene(&s);
    return status;
}

/* ---- files ----------------------------------------------------------------------------------------------------- */

static int write_table(const settings *set, const cut_run *runs, int count)
{
    char path[MOST_PATH + 32];
    sb_output out;
    snprintf(path, sizeof path, "%s.csv", set->out);
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return complain(path, "cannot be written", USAGE);
    fprintf(out.file, set->scissors ? "cut,closed_deg,moment_mNm,along_N,work_J,area_mm2\n"
                                    : "cut,depth_mm,across_N,along_N,work_J,area_mm2\n");
    for (int k = 0; k < count; k++)
        for (int i = 0; i < runs[k].frames; i++)
            fprintf(out.file, "%s,%.4f,%.4f,%.4f,%.6f,%.3f\n", runs[k].name, runs[k].way[i], runs[k].across[i],
                    runs[k].along[i], runs[k].work[i], runs[k].area[i]);
    return sb_output_close(&out, NULL) == SB_OK ? 0 : complain(path, "cannot be written", USAGE);
}

static int draw_chart(const settings *set, const cut_run *runs, int count)
{
    char path[MOST_PATH + 32];
    plot p;
    plot_panel *force, *work;
    plot_begin(&p, set->scissors ? "Scissors: the moment that closing takes" : "A blade: force across its edge");
    force = plot_add_panel(&p, set->scissors ? "moment at the hinge" : "force across the edge",
                           set->scissors ? "closed by (degrees)" : "depth (mm)",
                           set->scissors ? "moment (mN m)" : "force (N)");
    work = plot_add_panel(&p, "work for what has been freed", "area (mm2)", "work (J)");
    for (int k = 0; k < count; k++) {
        plot_add_curve(force, runs[k].label, runs[k].way, runs[k].across, runs[k].frames);
        plot_add_curve(work, runs[k].label, runs[k].area, runs[k].work, runs[k].frames);
    }
    snprintf(path, sizeof path, "%s.svg", set->out);
    return plot_save_svg(&p, path) ? 0 : complain(path, "cannot be written", USAGE);
}

static double highest(const double *values, int count)
{
    double most = 0;
    for (int i = 0; i < count; i++)
        most = fmax(most, values[i]);
    return most;
}

static void print_summary(const settings *set, const cut_run *runs, int count)
{
    printf("block       %.0f x %.0f x %.0f mm, %d cells over its height, ", 1e3 * width, 1e3 * breadth, 1e3 * height,
           set->cells);
    if (set->steps)
        printf("E %.4g Pa\n", set->young);
    else
        printf("held still\n");
    for (int k = 0; k < count; k++) {
        const cut_run *r = runs + k;
        int last = r->frames - 1;
        double area = 1e-6 * r->area[last];
        printf("%-11s J_c %g J/m2: %.3f %s at most, %.4f J for %.0f mm2, %.1f J/m2 with %.4f J not felt yet\n", r->name,
               r->toughness, highest(r->across, r->frames), set->scissors ? "mN m" : "N across the edge", r->work[last],
               r->area[last], area > 0 ? (r->work[last] + r->owed) / area : 0, r->owed);
    }
    printf("written     %s.csv, %s.svg\n", set->out, set->out);
    printf("most=%.3f work_J=%.5f area_mm2=%.1f frames=%d\n", highest(runs[0].across, runs[0].frames),
           runs[0].work[runs[0].frames - 1], runs[0].area[runs[0].frames - 1], runs[0].frames);
}

static int run_all(const settings *set)
{
    cut_run runs[RUNS];
    int count = set->scissors ? 2 : RUNS, status = 0;
    static const char *const names[2][RUNS] = {{"push", "slice", "half"}, {"close", "half", NULL}};
    memset(runs, 0, sizeof runs);
    for (int k = 0; k < count && !status; k++) {
        runs[k].name = names[set->scissors][k];
        runs[k].toughness = set->toughness / (k == count - 1 ? 2 : 1);
        runs[k].slice = !set->scissors && k == 1 ? set->slice : 0;
        if (runs[k].slice > 0)
            snprintf(runs[k].label, sizeof runs[k].label, "drawn by %g of its way, J_c %g J/m2", runs[k].slice,
                     runs[k].toughness);
        else
            snprintf(runs[k].label, sizeof runs[k].label, "straight, J_c %g J/m2", runs[k].toughness);
        status = cut_through(set, runs + k);
    }
    if (!status)
        status = write_table(set, runs, count);
    if (!status)
        status = draw_chart(set, runs, count);
    if (!status)
        print_summary(set, runs, count);
    for (int k = 0; k < count; k++)
        free(runs[k].way);
    return status;
}

/* ---- command line ---------------------------------------------------------------------------------------------- */

static settings default_settings(void)
{
    settings s;
    memset(&s, 0, sizeof s);
    s.out = program_name;
    s.front = "glue";
    s.toughness = 150;
    s.slice = 2;
    s.speed = 0.05;
    s.rate = 200;
    s.depth = 0.8;
    s.young = 40000;
    s.poisson = 0.4;
    s.cells = 8;
    s.lattice = 2;
    return s;
}

enum { OPTION_COUNT = 15 };
static void list_options(settings *s, option options[OPTION_COUNT])
{
    const option all[OPTION_COUNT] = {
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &s->out, 0, 0, "files are NAME.csv and NAME.svg"},
        {"--toughness", "J/M2", OPTION_NUMBER, NULL, &s->toughness, NULL, 0, 1e5,
         "J_c, the work that an area takes (J/m2); liver 76 to 225"},
        {"--slice", "XI", OPTION_NUMBER, NULL, &s->slice, NULL, 0, 10,
         "how far the blade is drawn along itself, of the way that it goes down"},
        {"--scissors", NULL, OPTION_FLAG, &s->scissors, NULL, NULL, 0, 0, "closes scissors across the block"},
        {"--steps", NULL, OPTION_FLAG, &s->steps, NULL, NULL, 0, 0, "the tissue moves, too"},
        {"--depth", "SHARE", OPTION_NUMBER, NULL, &s->depth, NULL, 0.01, 0.95,
         "of the height that the blade goes down"},
        {"--speed", "M/S", OPTION_NUMBER, NULL, &s->speed, NULL, 1e-3, 10, "of the blade, of scissors at their tips"},
        {"--rate", "HZ", OPTION_NUMBER, NULL, &s->rate, NULL, 10, 10000, "frames a second"},
        {"--young", "PA", OPTION_NUMBER, NULL, &s->young, NULL, 1, 1e9, "Young's modulus (Pa)"},
        {"--poisson", "NU", OPTION_NUMBER, NULL, &s->poisson, NULL, 0, 0.49, "Poisson's ratio"},
        {"--cells", "N", OPTION_INTEGER, &s->cells, NULL, NULL, 2, 40, "over the block's height"},
        {"--lattice", "M", OPTION_INTEGER, &s->lattice, NULL, NULL, 1, 4,
         "places along an element's edge that are cut apart: 1, 2 or 4"},
        {"--front", "KIND", OPTION_TEXT, NULL, NULL, &s->front, 0, 0,
         "lag: elements hold until they are cut through; glue: the cut opens with the blade"},
        {"--help", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, "this text"},
        {"-h", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, NULL},
    };
    memcpy(options, all, sizeof all);
}

static int check_settings(const settings *s)
{
    if (strlen(s->out) > MOST_PATH)
        return options_complain(program_name, "-o", "needs a shorter name");
    if (s->lattice == 3)
        return options_complain(program_name, "--lattice", "needs 1, 2 or 4");
    if (strcmp(s->front, "lag") != 0 && strcmp(s->front, "glue") != 0)
        return options_complain(program_name, "--front", "needs lag or glue");
    return 1;
}

static int program(int argc, char **argv)
{
    settings s = default_settings();
    option options[OPTION_COUNT];
    list_options(&s, options);
    if (!options_parse(program_name, options, OPTION_COUNT, NULL, 0, argc, argv))
        return USAGE;
    if (s.help) {
        s = default_settings();
        list_options(&s, options);
        printf(
            "usage: cut_force [OPTIONS]\n\n"
            "What a hand feels of cutting: a blade comes down through a block of tissue on a table, straight, drawn\n"
            "along itself, and through tissue half as tough; or scissors close across it.\n\n");
        options_print(options, OPTION_COUNT);
        printf("\nThe last line, of the first cut: the largest force across the edge (N), of scissors the moment\n"
               "(mN m), the work done, the area that was freed, and frames.\n");
        return 0;
    }
    return check_settings(&s) ? run_all(&s) : USAGE;
}

int main(int argc, char **argv) { return finish(program_name, program(argc, argv), USAGE); }
