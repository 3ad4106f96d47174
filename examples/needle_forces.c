/* needle_forces: what a hand feels of tissue: friction, membranes, slowness and sideways motion, as charts.
 *
 *     needle_forces [OPTIONS]      needle_forces --help lists them
 *
 * A needle goes into a block of gel that is held at its sides. Four experiments, after figures 7.4 to 7.6 of Chentanez,
 * Interactive simulation of needle insertion and steering (2010): it sticks and slips; it breaks through a skin and a
 * capsule; viscous friction drags the tissue along and lets go; the hand moves sideways. Each is written as a chart
 * (SVG) and as numbers (CSV). Exit status: 0, 2 wrong usage or a file that cannot be written, 3 a step failed or memory
 * is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#include "needle.h"

#include "options.h"
#include "plot.h"

enum { EXIT_USAGE = 2, EXIT_SOLVE = 3, MOST_SAMPLES = 1000, SERIES = 5 };

typedef struct settings {
    double young, friction; /* Pa, N/m */
    const char *out;
    int help;
} settings;

static const double dt = 0.02, speed = 0.01; /* s, m/s */

/* ---- gel and needle -------------------------------------------------------------------------------------------- */

/* 4 cm each way, the needle's tip 1 mm above the middle of its top. */
static const double size = 0.04;
enum { CELLS = 5 };

typedef struct scene {
    ndl_friction frictions[2]; /* of the upper and the lower half */
    const ndl_membrane *membranes;
    int membrane_count;
    ndl_rod_preset preset;
    sb_body *gel;
    ndl_needle *needle;
} scene;

static int complain(const char *what, const sb_error *error)
{
    fprintf(stderr, "needle_forces: %s: %s\n", what, error->message);
    return EXIT_SOLVE;
}

static int is_side(sb_vec3 x)
{
    double near_by = 1e-6;
    return x.x < near_by || x.y < near_by || x.x > size - near_by || x.y > size - near_by;
}

static sb_result make_gel(const settings *s, scene *c, sb_error *error)
{
    sb_body_def def = sb_default_body_def();
    sb_mesh mesh;
    sb_result result = sb_mesh_beam(SB_TET4, CELLS, CELLS, CELLS + 1, sb_v3(size, size, size), NULL, &mesh, error);
    if (result != SB_OK)
        return result;
    if (!mesh.regions)
        mesh.regions = (int *)malloc((size_t)mesh.element_count * sizeof(int));
    for (int e = 0; mesh.regions && e < mesh.element_count; e++) {
        double z = 0;
        for (int k = 0; k < 4; k++)
            z += mesh.nodes[mesh.elements[4 * e + k]].z / 4;
        mesh.regions[e] = z < size / 2;
    }
    def.mesh = &mesh;
    def.material = sb_material_corotated(s->young, 0.45, 1000);
    def.integrator = SB_GENERALISED_ALPHA; /* what dt cannot resolve is damped away: the hand feels no ringing */
    def.spectral_radius = 0;
    def.max_newton = 1;
    def.damping_stiffness = 0.005;
    def.tolerance = 1e-5;
    def.slack = 0.2; /* the mesh follows the needle */
    result = sb_body_create(&def, &c->gel, error);
    for (int i = 0; i < mesh.node_count && result == SB_OK; i++)
        if (is_side(mesh.nodes[i]))
            result = sb_body_hold(c->gel, &i, 1, SB_XYZ, error);
    sb_mesh_free(&mesh);
    return result;
}

static int make_scene(const settings *s, scene *c)
{
    ndl_needle_def def = ndl_default_needle_def();
    sb_error error;
    sb_result result = make_gel(s, c, &error);
    if (result != SB_OK)
        return complain("gel", &error);
    ndl_rod_section_preset(c->preset, &def.section);
    def.body = c->gel;
    def.follow = NDL_REMESH;
    def.base = sb_v3(0.53 * size, 0.48 * size, size + 0.051);
    def.direction = sb_v3(0, 0, -1);
    def.frictions = c->frictions;
    def.friction_count = 2;
    def.membranes = c->membranes;
    def.membrane_count = c->membrane_count;
    result = ndl_needle_create(&def, &c->needle, &error);
    return result == SB_OK ? 0 : complain("needle", &error);
}

static void free_scene(scene *c)
{
    ndl_needle_destroy(c->needle);
    sb_body_destroy(c->gel);
}

static int step(scene *c, double insertion, sb_vec3 velocity)
{
    ndl_command command;
    sb_error error;
    memset(&command, 0, sizeof command);
    command.insertion = insertion;
    command.velocity = velocity;
    if (ndl_step(c->gel, &c->needle, 1, dt, &command, NULL, &error) != SB_OK)
        return complain("step", &error);
    return 0;
}

/* What the hand pushes with (N). */
static double push_of(const scene *c)
{
    sb_vec3 force;
    ndl_needle_base_wrench(c->needle, &force, NULL);
    return -force.z;
}

/* How far the gel is displaced where the needle enters it (m). */
static sb_vec3 displacement_at_entry(const scene *c)
{
    int node = ndl_needle_body_node(c->needle, ndl_needle_entry(c->needle));
    return node < 0 ? sb_v3(0, 0, 0) : sb_body_displacements(c->gel)[node];
}

/* ---- numbers and charts ---------------------------------------------------------------------------------------- */

/* Columns of numbers; the first is what the others are drawn over. */
typedef struct record {
    const char *names[SERIES];
    double values[SERIES][MOST_SAMPLES];
    int series, count;
} record;

static void note(record *r, double a, double b, double c, double d, double e)
{
    const double row[SERIES] = {a, b, c, d, e};
    for (int k = 0; k < r->series && r->count < MOST_SAMPLES; k++)
        r->values[k][r->count] = row[k];
    r->count += r->count < MOST_SAMPLES;
}

static int write_numbers(const record *r, const char *path)
{
    sb_output out;
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return 0;
    for (int k = 0; k < r->series; k++)
        fprintf(out.file, "%s%s", k ? "," : "", r->names[k]);
    for (int i = 0; i < r->count; i++)
        for (int k = 0; k < r->series; k++)
            fprintf(out.file, "%s%.9g", k ? "," : "\n", r->values[k][i]);
    fputc('\n', out.file);
    return sb_output_close(&out, NULL) == SB_OK;
}

/* Writes PREFIX_NAME.svg and .csv. */
static int write_all(const settings *s, const plot *p, const record *r, const char *name)
{
    char chart[1024], numbers[1024];
    if (snprintf(chart, sizeof chart, "%s_%s.svg", s->out, name) >= (int)sizeof chart ||
        snprintf(numbers, sizeof numbers, "%s_%s.csv", s->out, name) >= (int)sizeof numbers) {
        fprintf(stderr, "needle_forces: %s is too long a name\n", s->out);
        return EXIT_USAGE;
    }
    if (!plot_save_svg(p, chart) || !write_numbers(r, numbers)) {
        fprintf(stderr, "needle_forces: %s or .csv cannot be written\n", chart);
        return EXIT_USAGE;
    }
    printf("%-11s %s, %s\n", name, chart, numbers);
    return 0;
}

static double extreme(const double *values, int from, int to, int sign)
{
    double most = sign * values[from];
    for (int i = from + 1; i < to; i++)
        most = fmax(most, sign * values[i]);
    return sign * most;
}

/* ---- sticks and slips ------------------------------------------------------------------------------------------ */

static int record_stick_slip(const settings *s, scene *c, record *r)
{
    static const double legs[5] = {-0.003, 0.006, -0.006, 0.006, -0.006}; /* m, of 60 steps each */
    double way = 0;
    int status = 0;
    for (int i = 0; i < 120 && !status; i++)
        status = step(c, speed, sb_v3(0, 0, 0));
    for (int i = 0; i < 5 * 60 && !status; i++) {
        double limit = s->friction * ndl_needle_depth(c->needle);
        double part = legs[i / 60] / 60;
        status = step(c, 0, sb_v3(0, 0, -part / dt));
        way += part;
        note(r, 1e3 * way, push_of(c), limit, -limit, -1e3 * displacement_at_entry(c).z);
    }
    return status;
}

static int study_stick_slip(const settings *s, record *r)
{
    scene c = {{{s->friction, 0, 0, 0, 0}, {s->friction, 0, 0, 0, 0}}, NULL, 0, NDL_STYLET_18G, NULL, NULL};
    plot p;
    plot_panel *panel;
    int status = make_scene(s, &c);
    if (!status)
        status = record_stick_slip(s, &c, r);
    free_scene(&c);
    if (status)
        return status;
    plot_begin(&p, "A needle that sticks, slips and turns back");
    panel = plot_add_panel(&p, "Force over the way of the hand", "way of the hand (mm)", "push (N)");
    plot_add_curve(panel, "push", r->values[0], r->values[1], r->count);
    plot_add_curve(panel, "friction times depth", r->values[0], r->values[2], r->count)->dashed = 1;
    plot_add_curve(panel, "the same, backwards", r->values[0], r->values[3], r->count)->dashed = 1;
    panel = plot_add_panel(&p, "How far the skin comes along", "way of the hand (mm)", "skin at the needle (mm)");
    plot_add_curve(panel, "skin", r->values[0], r->values[4], r->count);
    printf("sticks, slips: between %.3f and %.3f N, friction times depth is %.3f N\n",
           extreme(r->values[1], 60, r->count, -1), extreme(r->values[1], 60, r->count, 1), r->values[2][r->count - 1]);
    return write_all(s, &p, r, "stick_slip");
}

/* ---- skin and capsule: figure 7.5 ------------------------------------------------------------------------------ */

static int study_puncture(const settings *s, record *r)
{
    static const ndl_membrane membranes[2] = {{{-1, 0}, 3, 0.001}, {{0, 1}, 2, 0.001}};
    scene c = {{{5, 0, 0.2, 0, 0}, {5, 0, 0.2, 0, 0}}, membranes, 2, NDL_STYLET_18G, NULL, NULL};
    plot p;
    plot_panel *panel;
    int status = make_scene(s, &c);
    for (int i = 0; i < 190 && !status; i++) {
        status = step(&c, speed, sb_v3(0, 0, 0));
        note(r, 1e3 * ndl_needle_fed(c.needle) - 1, push_of(&c), ndl_needle_cutting(c.needle),
             -1e3 * displacement_at_entry(&c).z, 1e3 * ndl_needle_depth(c.needle));
    }
    free_scene(&c);
    if (status)
        return status;
    plot_begin(&p, "Through a skin and a capsule");
    panel = plot_add_panel(&p, "Force", "insertion past the skin's place (mm)", "force (N)");
    plot_add_curve(panel, "push of the hand", r->values[0], r->values[1], r->count);
    plot_add_curve(panel, "needed to cut", r->values[0], r->values[2], r->count)->dashed = 1;
    panel = plot_add_panel(&p, "Dent of the skin, and depth", "insertion past the skin's place (mm)", "mm");
    plot_add_curve(panel, "dent at the needle", r->values[0], r->values[3], r->count);
    plot_add_curve(panel, "shaft in the gel", r->values[0], r->values[4], r->count);
    printf("skin, capsule: peaks of %.3f and %.3f N, %.3f N before the capsule\n", extreme(r->values[1], 0, 90, 1),
           extreme(r->values[1], 110, r->count, 1), extreme(r->values[1], 90, 100, 1));
    return write_all(s, &p, r, "puncture");
}

/* ---- viscous friction: figure 7.4 ------------------------------------------------------------------------------ */

/* In to half of the gel at 1, 2 and 4 times a speed, then held still: pushes and displacement into columns. */
static int record_viscous(const settings *s, record *r, int run)
{
    scene c = {{{1, 500, 0, 0, 0}, {1, 500, 0, 0, 0}}, NULL, 0, NDL_STYLET_18G, NULL, NULL};
    int going = 126 >> run, status = make_scene(s, &c);
    double fast = 0.5 * speed * (1 << run) * 1.66;
    for (int i = 0; i < 200 && !status; i++) {
        status = step(&c, i < going ? fast : 0, sb_v3(0, 0, 0));
        r->values[0][i] = (i + 1) * dt;
        r->values[1 + run][i] = push_of(&c);
        if (run == 1)
            r->values[4][i] = -1e3 * displacement_at_entry(&c).z;
    }
    r->count = 200;
    free_scene(&c);
    return status;
}

static int study_viscous(const settings *s, record *r)
{
    plot p;
    plot_panel *panel;
    int status = 0;
    for (int run = 0; run < 3 && !status; run++)
        status = record_viscous(s, r, run);
    if (status)
        return status;
    plot_begin(&p, "Viscous friction: pushed in, then held still");
    panel = plot_add_panel(&p, "Force at three speeds", "time (s)", "push (N)");
    for (int run = 0; run < 3; run++)
        plot_add_curve(panel,
                       run == 0   ? "8.3 mm/s"
                       : run == 1 ? "16.6 mm/s"
                                  : "33.2 mm/s",
                       r->values[0], r->values[1 + run], r->count);
    panel = plot_add_panel(&p, "The gel goes along and slides back (16.6 mm/s)", "time (s)", "skin at the needle (mm)");
    plot_add_curve(panel, "skin", r->values[0], r->values[4], r->count);
    printf("viscous:       peaks of %.3f, %.3f and %.3f N, %.4f N once it is still\n",
           extreme(r->values[1], 0, r->count, 1), extreme(r->values[2], 0, r->count, 1),
           extreme(r->values[3], 0, r->count, 1), r->values[3][r->count - 1]);
    return write_all(s, &p, r, "viscous");
}

/* ---- sideways: figure 7.6 -------------------------------------------------------------------------------------- */

static int study_lateral(const settings *s, record *r)
{
    scene c = {{{s->friction, 0, 0.3, 0, 0}, {s->friction, 0, 0.3, 0, 0}}, NULL, 0, NDL_NITINOL_083, NULL, NULL};
    plot p;
    plot_panel *panel;
    double aside = 0;
    int status = make_scene(s, &c);
    for (int i = 0; i < 30 && !status; i++)
        status = step(&c, speed, sb_v3(0, 0, 0));
    for (int i = 0; i < 300 && !status; i++) { /* by 4 mm to both sides, once in 2 s */
        double velocity = 0.004 * 3.14159265 * cos(3.14159265 * dt * (i + 0.5));
        sb_vec3 force;
        status = step(&c, 0.4 * speed, sb_v3(velocity, 0, 0));
        aside += velocity * dt;
        ndl_needle_base_wrench(c.needle, &force, NULL);
        note(r, (i + 1) * dt, 1e3 * aside, 1e3 * displacement_at_entry(&c).x, force.x,
             1e3 * ndl_needle_depth(c.needle));
    }
    free_scene(&c);
    if (status)
        return status;
    plot_begin(&p, "The hand moves sideways while the needle goes in");
    panel = plot_add_panel(&p, "The gel goes to the same side", "time (s)", "sideways (mm)");
    plot_add_curve(panel, "hand", r->values[0], r->values[1], r->count);
    plot_add_curve(panel, "gel where the needle enters", r->values[0], r->values[2], r->count);
    panel = plot_add_panel(&p, "Force on the hand's way", "hand sideways (mm)", "sideways push (N)");
    plot_add_curve(panel, "push", r->values[1], r->values[3], r->count);
    printf("sideways:      %.3f N for %.2f mm, the gel goes by %.3f mm\n", extreme(r->values[3], 0, r->count, 1),
           extreme(r->values[1], 0, r->count, 1), extreme(r->values[2], 0, r->count, 1));
    return write_all(s, &p, r, "lateral");
}

/* ---- the program ----------------------------------------------------------------------------------------------- */

typedef struct experiment {
    int (*study)(const settings *s, record *r);
    const char *names[SERIES];
} experiment;

static int run_all(const settings *s)
{
    static const experiment experiments[4] = {
        {study_stick_slip, {"way_mm", "push_N", "limit_N", "limit_back_N", "skin_mm"}},
        {study_puncture, {"insertion_mm", "push_N", "cutting_N", "dent_mm", "depth_mm"}},
        {study_viscous, {"time_s", "push_slow_N", "push_N", "push_fast_N", "skin_mm"}},
        {study_lateral, {"time_s", "hand_mm", "gel_mm", "push_N", "depth_mm"}},
    };
    record *r = (record *)malloc(sizeof *r);
    int status = 0;
    if (!r) {
        fprintf(stderr, "needle_forces: out of memory\n");
        return EXIT_SOLVE;
    }
    for (int i = 0; i < 4 && !status; i++) {
        memset(r, 0, sizeof *r);
        memcpy(r->names, experiments[i].names, sizeof r->names);
        r->series = SERIES;
        status = experiments[i].study(s, r);
    }
    free(r);
    return status;
}

static int program(int argc, char **argv)
{
    settings s = {50000, 30, "needle_forces", 0};
    const option options[] = {
        {"--young", "PA", OPTION_NUMBER, NULL, &s.young, NULL, 5e3, 1e9, "stiffness (Pa) of the gel"},
        {"--friction", "N/M", OPTION_NUMBER, NULL, &s.friction, NULL, 1, 1000, "friction (N/m) where it sticks"},
        {"-o", "PREFIX", OPTION_TEXT, NULL, NULL, &s.out, 0, 0, "writes PREFIX_stick_slip.svg and .csv, and so on"},
        {"--help", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, "this text"},
        {"-h", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, NULL},
    };
    const int count = (int)(sizeof options / sizeof options[0]);
    if (!options_parse("needle_forces", options, count, NULL, 0, argc, argv))
        return EXIT_USAGE;
    if (s.help) {
        printf("usage: needle_forces [OPTIONS]\n\n"
               "Forces between a needle and gel: sticking and slipping, punctures, viscous friction, sideways motion;\n"
               "each as a chart and as numbers.\n\n");
        options_print(options, count);
        return 0;
    }
    return run_all(&s);
}

int main(int argc, char **argv) { return finish("needle_forces", program(argc, argv), EXIT_USAGE); }
