/* ablation: an applicator burns tissue inside an organ; how hot it gets, what dies, and how much stiffer that is.
 *
 *     ablation [ORGAN] [OPTIONS]      ablation --help lists the options
 *
 * Without a file an organ like a liver is made. A needle comes straight down from above; its active tip heats the
 * tissue around it for a time, then it cools. Blood carries heat away where tissue lives, and no more where it has
 * died. The organ stands on its lower side and sags under its weight, before and after. Written are a table over time
 * (CSV), the temperatures at the end of heating and the dead share at the end (VTK), and a picture of the organ cut
 * open at the needle. Exit status: 0, 2 wrong usage or a file that cannot be read or written, 3 a step failed or memory
 * is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "options.h"
#include "organ_scene.h"

#define REAL(x) ((sb_real)(x)) /* everything here computes in double, the body in sb_real */

static const char *const program_name = "ablation";
static const double zero_celsius = 273.15; /* K */
static const double soft_limit = 5;        /* K, over which the generator fades */
static const double standing = 0.12;       /* share of the organ's height that is held, from below */

typedef struct settings {
    const char *organ, *out;
    double scale, x, y, depth, active, radius, power, limit, time, cool, dt, every, perfusion, stiffening, young;
    int cells, dead, keeps, help;
} settings;

typedef struct work {
    const settings *set;
    organ scene;
    sb_heat *heat;
    int tip;             /* number of the source */
    sb_vec3 end, begin;  /* m, of the active tip: its point, and where it begins above */
    sb_real *hottest;    /* [nodes] degrees Celsius at the end of heating */
    sb_real *dead;       /* [nodes] share at the end */
    double sank[2];      /* m, of the highest node: before, after */
    double now, highest; /* degrees Celsius, of the hottest node */
    double error;        /* of the balance of heat, relative */
    int steps;
} work;

/* ---- the organ ------------------------------------------------------------------------------------------------- */

static int make_mesh(work *w)
{
    const settings *s = w->set;
    sb_error error;
    int status;
    w->scene = organ_named(program_name);
    if (s->organ) {
        status = organ_load(&w->scene, s->organ, s->scale);
        return status ? status : organ_make_skin(&w->scene);
    }
    if (sb_mesh_organ(SB_TET4, s->cells, NULL, &w->scene.mesh, &error) != SB_OK)
        return organ_complain_of(&w->scene, "the organ", &error, ORGAN_USAGE);
    return organ_make_skin(&w->scene);
}

static int make_body(work *w)
{
    organ *o = &w->scene;
    sb_body_def def = sb_default_body_def();
    sb_real floor_height = o->low.z + REAL(standing) * (o->high.z - o->low.z);
    sb_error error;
    int status;
    def.material = sb_material_corotated(REAL(w->set->young), REAL(0.4), 1060);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    status = organ_make_body(o, &def, NULL);
    for (int i = 0; i < o->mesh.node_count && !status; i++)
        if (o->mesh.nodes[i].z < floor_height && sb_body_hold(o->body, &i, 1, SB_XYZ, &error) != SB_OK)
            status = organ_complain_of(o, "the organ", &error, ORGAN_FAILED);
    return status;
}

/* Where the needle's point is: so deep below the skin that is seen from above. */
static int place_needle(work *w)
{
    const settings *s = w->set;
    const organ *o = &w->scene;
    sb_vec3 from = sb_v3(o->low.x + REAL(s->x) * (o->high.x - o->low.x), o->low.y + REAL(s->y) * (o->high.y - o->low.y),
                         2 * o->high.z - o->low.z);
    sb_surface_hit hit;
    if (!sb_surface_ray(o->skin, from, sb_v3(0, 0, -1), SB_REAL_MAX, &hit))
        return organ_complain(o, "the needle", "meets no organ there: choose another --x and --y", ORGAN_USAGE);
    w->end = sb_v3(hit.point.x, hit.point.y, hit.point.z - REAL(s->depth));
    w->begin = sb_v3(w->end.x, w->end.y, w->end.z + REAL(fmin(s->active, s->depth)));
    if (sb_surface_signed_distance(o->skin, w->end, NULL) > 0)
        return organ_complain(o, "the needle", "comes out of the organ below: choose a smaller --depth", ORGAN_USAGE);
    return 0;
}

static int make_heat(work *w)
{
    const settings *s = w->set;
    sb_heat_def def = sb_default_heat_def();
    size_t nodes = (size_t)w->scene.mesh.node_count;
    sb_error error;
    def.tissue.perfusion = REAL(s->perfusion);
    def.tissue.latent_heat = REAL(1.8e9); /* J/m^3: water in tissue boils */
    def.keeps_perfusion = s->keeps;
    def.stiffening = REAL(s->stiffening);
    w->hottest = (sb_real *)malloc(nodes * sizeof *w->hottest);
    w->dead = (sb_real *)malloc(nodes * sizeof *w->dead);
    if (!w->hottest || !w->dead)
        return organ_complain_memory(&w->scene);
    if (sb_heat_create(w->scene.body, &def, &w->heat, &error) != SB_OK ||
        sb_heat_add_source(w->heat, w->end, w->begin, REAL(s->radius), REAL(s->power), &w->tip, &error) != SB_OK)
        return organ_complain_of(&w->scene, "heat", &error, ORGAN_FAILED);
    return 0;
}

/* ---- burning --------------------------------------------------------------------------------------------------- */

/* How far the highest node of the organ sinks under its weight. */
static int let_sag(work *w, double *sank)
{
    const organ *o = &w->scene;
    sb_step_info info;
    int top = 0;
    if (sb_body_solve_static(o->body, NULL, &info) != SB_OK)
        return organ_complain_of(o, "the organ finds no rest", &info.error, ORGAN_FAILED);
    for (int i = 0; i < o->mesh.node_count; i++)
        if (o->mesh.nodes[i].z > o->mesh.nodes[top].z)
            top = i;
    *sank = -(double)sb_body_displacements(o->body)[top].z;
    return 0;
}

static int sag_before(work *w) { return let_sag(w, &w->sank[0]); }
static int sag_after(work *w) { return let_sag(w, &w->sank[1]); }

static void write_row(FILE *file, const work *w, double time, const sb_heat_info *info)
{
    sb_heat_flows sums = sb_heat_balance(w->heat);
    fprintf(file, "%.6g,%.6g,%.6g,%.6g,%.6g,%.6g,%.6g\n", time, info->flows.source,
            (double)info->highest - zero_celsius, 1e6 * (double)info->dead_volume, sums.source, sums.perfused,
            sums.stored);
}

/* What is shown of the end of heating. */
static void note_hottest(work *w)
{
    for (int i = 0; i < w->scene.mesh.node_count; i++)
        w->hottest[i] = sb_heat_temperatures(w->heat)[i] - REAL(zero_celsius);
}

/* The generator: full power up to some kelvin below the limit, none at it. */
static double power_at(const settings *s, double temperature)
{
    double share = (s->limit - temperature) / soft_limit;
    return s->power * (share < 0 ? 0 : share > 1 ? 1 : share);
}

/* One step; what it reports goes to the table now and then. */
static int burn_step(work *w, FILE *file, double time, int heats)
{
    const settings *s = w->set;
    sb_heat_info info;
    sb_error error;
    char words[96];
    sb_heat_set_source(w->heat, w->tip, REAL(heats ? power_at(s, w->now) : 0));
    if (sb_heat_step(w->heat, REAL(s->dt), &info, &error) != SB_OK)
        return organ_complain_of(&w->scene, "a step of heat failed", &error, ORGAN_FAILED);
    w->now = (double)info.highest - zero_celsius;
    w->highest = fmax(w->highest, w->now);
    if (floor(time / s->every + 1e-9) > floor((time - s->dt) / s->every + 1e-9))
        write_row(file, w, time, &info);
    snprintf(words, sizeof words, "%.0f s, %.1f C, %.2f ml dead", time, (double)info.highest - zero_celsius,
             1e6 * (double)info.dead_volume);
    progress_show(time / (s->time + s->cool), words);
    return 0;
}

static int burn(work *w)
{
    const settings *s = w->set;
    int heating = (int)ceil(s->time / s->dt - 1e-9), all = heating + (int)ceil(s->cool / s->dt - 1e-9), status = 0;
    char path[ORGAN_PATH + 32];
    sb_output out;
    sb_heat_flows sums;
    snprintf(path, sizeof path, "%s.csv", s->out);
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return organ_complain_file(&w->scene, path);
    fprintf(out.file, "time_s,power_W,highest_C,dead_ml,given_J,perfused_J,stored_J\n");
    for (w->steps = 0; w->steps < all && !status; w->steps++) {
        status = burn_step(w, out.file, (w->steps + 1) * s->dt, w->steps < heating);
        if (w->steps + 1 == heating)
            note_hottest(w);
    }
    progress_end();
    sums = sb_heat_balance(w->heat);
    w->error = fabs(sums.error) / fmax(fabs(sums.source), 1e-30);
    sb_heat_dead_shares(w->heat, w->dead);
    if (sb_output_close(&out, NULL) != SB_OK && !status)
        status = organ_complain_file(&w->scene, path);
    return status;
}

/* ---- what is written ------------------------------------------------------------------------------------------- */

static int write_mesh(work *w)
{
    char path[ORGAN_PATH + 32];
    sb_error error;
    const sb_field fields[3] = {
        {"temperature_C", SB_FIELD_NODES, 1, w->hottest},
        {"dead_share", SB_FIELD_NODES, 1, w->dead},
        {"displacement", SB_FIELD_NODES, 3, &sb_body_displacements(w->scene.body)[0].x},
    };
    snprintf(path, sizeof path, "%s.vtk", w->set->out);
    if (sb_mesh_save_vtk_binary(path, &w->scene.mesh, fields, 3, &error) != SB_OK)
        return organ_complain_of(&w->scene, path, &error, ORGAN_USAGE);
    return 0;
}

/* The organ at rest, cut open at the needle where it is made of tet4, coloured from low to high. */
static void draw_organ(picture *p, const work *w, const sb_real *values, double low, double high)
{
    const organ *o = &w->scene;
    picture_plane plane;
    plane.normal = picture_v(0, 1, 0);
    plane.offset = (double)w->end.y;
    for (int i = 0; i < o->mesh.node_count; i++)
        o->numbers[i] = REAL(fmax(0, (double)values[i] - low));
    organ_draw(o, p, o->mesh.nodes, o->numbers, high - low);
    if (o->mesh.element_type != SB_TET4)
        return;
    picture_clip(p, 0, plane);
    picture_add_section(p, &o->mesh, o->numbers, 0, high - low, plane);
}

static int draw_picture(work *w)
{
    const settings *s = w->set;
    const int width = 1280, height = 960;
    double low = s->dead ? 0 : 37, high = s->dead ? 1 : 100;
    char path[ORGAN_PATH + 32], title[128], details[200];
    sb_vec3 out = sb_v3(w->end.x, w->end.y, w->scene.high.z + REAL(0.4) * (w->scene.high.z - w->scene.low.z));
    picture p;
    picture_begin(&p, width, height);
    draw_organ(&p, w, s->dead ? w->dead : w->hottest, low, high);
    picture_add_capsule(&p, w->end, w->begin, 0.0012, picture_web(0xd55e00));
    picture_add_capsule(&p, w->begin, out, 0.001, picture_web(0x9aa3ad));
    picture_render(&p, 15, 20);
    picture_colour_bar(&p, s->dead ? "dead share" : "temperature", s->dead ? "" : "C", low, high,
                       s->dead ? 1 : w->highest);
    picture_length_bar(&p);
    snprintf(title, sizeof title, "At most %.0f W for %.0f s: %.1f ml are dead", s->power, s->time,
             1e6 * (double)sb_heat_dead_volume(w->heat));
    snprintf(details, sizeof details, "%s; the active tip of %.0f mm is orange",
             s->dead ? "after cooling" : "at the end of heating", 1e3 * s->active);
    picture_text(&p, 0.06 * width, 0.075 * height, 22, PICTURE_LEFT, picture_ink(), title);
    picture_text(&p, 0.06 * width, 0.115 * height, 14, PICTURE_LEFT, picture_ink(), details);
    snprintf(path, sizeof path, "%s.png", s->out);
    return organ_save_picture(&w->scene, &p, path);
}

static int print_summary(work *w)
{
    const settings *s = w->set;
    printf("organ       %s: %d nodes, %d %s\n", s->organ ? s->organ : "like a liver", w->scene.mesh.node_count,
           w->scene.mesh.element_count, sb_element_name(w->scene.mesh.element_type));
    printf("heat        up to %.4g W around %.1f mm at (%.1f, %.1f, %.1f) mm for %.4g s, %.4g s to cool, %d steps\n",
           s->power, 1e3 * s->active, 1e3 * (double)w->end.x, 1e3 * (double)w->end.y, 1e3 * (double)w->end.z, s->time,
           s->cool, w->steps);
    printf("sank        %.3f mm before, %.3f mm after: dead tissue is %.3g times as stiff\n", 1e3 * w->sank[0],
           1e3 * w->sank[1], 1 + s->stiffening);
    printf("written     %s.csv, %s.vtk, %s.png\n", s->out, s->out, s->out);
    printf("dead_ml=%.3f highest_c=%.1f balance=%.1e\n", 1e6 * (double)sb_heat_dead_volume(w->heat), w->highest,
           w->error);
    return 0;
}

static int run(const settings *set)
{
    static int (*const stages[])(work *) = {make_mesh, place_needle, make_body,  make_heat,    sag_before,
                                            burn,      sag_after,    write_mesh, draw_picture, print_summary};
    work w;
    int status = 0;
    memset(&w, 0, sizeof w);
    w.set = set;
    for (size_t i = 0; i < sizeof stages / sizeof stages[0] && !status; i++)
        status = stages[i](&w);
    sb_heat_destroy(w.heat);
    organ_free(&w.scene);
    free(w.hottest);
    free(w.dead);
    return status;
}

/* ---- command line ---------------------------------------------------------------------------------------------- */

static settings default_settings(void)
{
    settings s;
    memset(&s, 0, sizeof s);
    s.out = program_name;
    s.scale = 1;
    s.x = 0.35, s.y = 0.5;
    s.depth = 0.05;
    s.active = 0.02;
    s.radius = 0.003;
    s.power = 40;
    s.limit = 100;
    s.time = 600;
    s.cool = 120;
    s.dt = 1;
    s.every = 10;
    s.perfusion = 24041;
    s.stiffening = 4;
    s.young = 5000;
    s.cells = 24;
    return s;
}

enum { OPTION_COUNT = 21 };
static void list_options(settings *s, option options[OPTION_COUNT])
{
    const option all[OPTION_COUNT] = {
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &s->out, 0, 0, "files are NAME.csv, NAME.vtk and NAME.png"},
        {"--scale", "X", OPTION_NUMBER, NULL, &s->scale, NULL, 1e-9, 1e9,
         "multiplies the file's lengths; 0.001 for millimetres"},
        {"--x", "SHARE", OPTION_NUMBER, NULL, &s->x, NULL, 0, 1, "the needle's place, as a share of the organ's width"},
        {"--y", "SHARE", OPTION_NUMBER, NULL, &s->y, NULL, 0, 1, "and of its length"},
        {"--depth", "M", OPTION_NUMBER, NULL, &s->depth, NULL, 1e-4, 1, "of its point below the skin (m)"},
        {"--active", "M", OPTION_NUMBER, NULL, &s->active, NULL, 0, 1, "length of its active tip (m)"},
        {"--radius", "M", OPTION_NUMBER, NULL, &s->radius, NULL, 0, 0.1,
         "standard deviation of its heat around the tip (m)"},
        {"--power", "W", OPTION_NUMBER, NULL, &s->power, NULL, 0, 1e4, "that arrives in the tissue (W)"},
        {"--limit", "C", OPTION_NUMBER, NULL, &s->limit, NULL, 38, 1e4,
         "temperature at which the generator gives none (C)"},
        {"--time", "S", OPTION_NUMBER, NULL, &s->time, NULL, 0.01, 1e5, "of heating (s)"},
        {"--cool", "S", OPTION_NUMBER, NULL, &s->cool, NULL, 0, 1e5, "afterwards (s)"},
        {"--dt", "S", OPTION_NUMBER, NULL, &s->dt, NULL, 1e-3, 60, "of a step (s)"},
        {"--every", "S", OPTION_NUMBER, NULL, &s->every, NULL, 1e-3, 1e5, "time between rows of the table (s)"},
        {"--perfusion", "X", OPTION_NUMBER, NULL, &s->perfusion, NULL, 0, 1e7,
         "heat that blood takes (W/m^3 for each kelvin)"},
        {"--keep", NULL, OPTION_FLAG, &s->keeps, NULL, NULL, 0, 0, "blood flows on in dead tissue"},
        {"--stiffen", "S", OPTION_NUMBER, NULL, &s->stiffening, NULL, 0, 1e3, "dead tissue is 1 + S times as stiff"},
        {"--young", "PA", OPTION_NUMBER, NULL, &s->young, NULL, 100, 1e9, "Young's modulus of the organ (Pa)"},
        {"--cells", "N", OPTION_INTEGER, &s->cells, NULL, NULL, 4, 60, "of the made organ over its width"},
        {"--dead", NULL, OPTION_FLAG, &s->dead, NULL, NULL, 0, 0, "the picture shows what is dead, not how hot it was"},
        {"--help", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, "this text"},
        {"-h", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, NULL},
    };
    memcpy(options, all, sizeof all);
}

static int program(int argc, char **argv)
{
    settings s = default_settings();
    option options[OPTION_COUNT];
    list_options(&s, options);
    if (!options_parse(program_name, options, OPTION_COUNT, &s.organ, 1, argc, argv))
        return ORGAN_USAGE;
    if (s.help) {
        s = default_settings();
        list_options(&s, options);
        printf("usage: ablation [ORGAN] [OPTIONS]\n\n"
               "An applicator burns tissue inside an organ: how hot it gets, what dies, how much stiffer that is.\n"
               "ORGAN: a volume mesh in metres (VTK, VTU, gmsh, Medit or TetGen) that stands on its lower side;\n"
               "without it an organ like a liver is made.\n\n");
        options_print(options, OPTION_COUNT);
        printf("\nThe last line: volume of tissue that is dead, the highest temperature that was reached, and by how\n"
               "much of the heat that was given the balance of heat is off.\n");
        return 0;
    }
    return organ_check_name(program_name, "-o", s.out) ? run(&s) : ORGAN_USAGE;
}

int main(int argc, char **argv) { return finish(program_name, program(argc, argv), ORGAN_USAGE); }
