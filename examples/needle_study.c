/* needle_study: what of a needle in tissue depends on the mesh and on the step, as charts.
 *
 *     needle_study [OPTIONS]      needle_study --help lists them
 *
 * Four studies, of blocks of gel that are held at their sides. Over the mesh's edges: how stiff the base is when it is
 * pushed aside, beside a solid needle in a graded mesh of hex20; how far a bevelled tip comes aside 8 cm deep; how far
 * the shaft lies off the way that its tip cut, in stiff gel. Over the step: the peak of a skin's puncture, and the most
 * that a hand feels beyond friction and cutting. Each number is a row of NAME.csv; charts are NAME_mesh.svg and
 * NAME_step.svg. Exit status: 0, 2 wrong usage or a file that cannot be written, 3 a step failed or memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#define NDL_IMPLEMENTATION
#include "needle.h"

#include "options.h"
#include "plot.h"

enum { EXIT_USAGE = 2, EXIT_SOLVE = 3, GELS = 3, MOST = 5, MOST_POINTS = 256 };

typedef struct settings {
    const char *out;
    int remesh, quick, all, help;
    int edges; /* of the mesh, that are tried */
    FILE *csv;
    int status;
} settings;

/* A block of gel with its top at z = height, and a needle above it. */
typedef struct scene {
    sb_mesh mesh;
    sb_body *gel;
    ndl_needle *needle;
    ndl_needle_def def;
    ndl_friction friction;
    double height; /* m */
} scene;

/* A needle with its tip 1 mm above the middle of the top, its sleeve `out` (m) above that. */
static scene scene_begin(const settings *s, double height, double out, ndl_rod_preset preset)
{
    scene c;
    memset(&c, 0, sizeof c);
    c.height = height;
    c.def = ndl_default_needle_def();
    c.def.follow = s->remesh ? NDL_REMESH : NDL_EMBED;
    c.def.direction = sb_v3(0, 0, -1);
    c.def.director = sb_v3(-1, 0, 0); /* it bends towards +y */
    c.def.length = (sb_real)(out - 0.001);
    c.def.base = sb_v3(0, 0, (sb_real)(height + out));
    ndl_rod_section_preset(preset, &c.def.section);
    return c;
}

static void scene_end(scene *c)
{
    ndl_needle_destroy(c->needle);
    sb_body_destroy(c->gel);
    sb_mesh_free(&c->mesh);
}

/* 0 with a message: there is no memory, or an argument is no good. */
static int scene_make(scene *c, double width, double edge, double young, double across)
{
    sb_body_def def = sb_default_body_def();
    sb_error error;
    sb_vec3 size = sb_v3((sb_real)width, (sb_real)width, (sb_real)c->height);
    int cells = (int)(width / edge + 0.5), layers = (int)(c->height / edge + 0.5), good;
    good = sb_mesh_beam(SB_TET4, cells, cells, layers, size, NULL, &c->mesh, &error) == SB_OK;
    def.mesh = &c->mesh;
    def.material = sb_material_corotated((sb_real)young, (sb_real)0.45, 1000);
    def.integrator = SB_GENERALISED_ALPHA;
    def.spectral_radius = 0;
    def.max_newton = 1;
    def.damping_stiffness = (sb_real)0.005;
    def.slack = (sb_real)0.2;
    def.max_iterations = 2000;
    good = good && sb_body_create(&def, &c->gel, &error) == SB_OK;
    for (int i = 0; good && i < c->mesh.node_count; i++) {
        sb_vec3 X = c->mesh.nodes[i];
        sb_real near = (sb_real)(1e-6 * width), far = (sb_real)width - near;
        if (X.x < near || X.y < near || X.x > far || X.y > far)
            good = sb_body_hold(c->gel, &i, 1, SB_XYZ, NULL) == SB_OK;
    }
    c->def.body = c->gel;
    c->def.base.x = (sb_real)(0.503 * width), c->def.base.y = (sb_real)across; /* on no node's line */
    c->def.frictions = &c->friction;
    c->def.friction_count = 1;
    good = good && ndl_needle_create(&c->def, &c->needle, &error) == SB_OK;
    if (!good)
        fprintf(stderr, "needle_study: %s\n", error.message);
    return good;
}

static int scene_step(scene *c, double dt, double speed, double aside)
{
    ndl_command command;
    sb_error error;
    memset(&command, 0, sizeof command);
    command.insertion = (sb_real)speed;
    command.velocity.x = (sb_real)aside;
    if (ndl_step(c->gel, &c->needle, 1, (sb_real)dt, &command, NULL, &error) == SB_OK)
        return 1;
    fprintf(stderr, "needle_study: %s\n", error.message);
    return 0;
}

static int scene_go(scene *c, double dt, int steps, double speed, double aside)
{
    for (int i = 0; i < steps; i++)
        if (!scene_step(c, dt, speed, aside))
            return 0;
    return 1;
}

static sb_vec3 scene_force(const scene *c)
{
    sb_vec3 force;
    ndl_needle_base_wrench(c->needle, &force, NULL);
    return force;
}

static sb_vec3 scene_tip(const scene *c)
{
    const ndl_rod *rod = ndl_needle_rod(c->needle);
    return ndl_rod_positions(rod)[ndl_rod_node_count(rod) - 1];
}

/* ---- studies: one number each; NaN: a step failed ---------------------------------------------------------------- */

/* N/m of the base, the needle 45 mm deep. */
static double base_stiffness(const settings *s, ndl_rod_preset preset, double young, double edge)
{
    scene c = scene_begin(s, 0.07, 0.012, preset);
    double before, found = (double)NAN;
    if (scene_make(&c, 0.07, edge, young, 0.0341) && scene_go(&c, 0.05, 46, 0.02, 0)) {
        before = (double)scene_force(&c).x;
        if (scene_go(&c, 0.05, 4, 0, 0.0025) && scene_go(&c, 0.05, 16, 0, 0))
            found = ((double)scene_force(&c).x - before) / 0.0005;
    }
    scene_end(&c);
    return found;
}

static double tip_aside(const settings *s, double young, double edge)
{
    scene c = scene_begin(s, 0.11, 0.012, NDL_NITINOL_083);
    double found = (double)NAN;
    int good;
    c.friction.friction = 5, c.friction.cutting = (sb_real)0.1;
    c.def.bevel.curvature = 8;
    good = scene_make(&c, 0.11, edge, young, 0.0411);
    for (int i = 0; good && i < 400 && ndl_needle_depth(c.needle) < (sb_real)0.08; i++)
        good = scene_step(&c, 0.04, 0.02, 0);
    if (good)
        found = (double)(scene_tip(&c).y - c.def.base.y);
    scene_end(&c);
    return found;
}

/* Distance of x from a polyline (m). */
static double off_way(const sb_vec3 *way, int count, sb_vec3 x)
{
    double least = HUGE_VAL;
    for (int i = 0; i + 1 < count; i++) {
        sb_vec3 edge = sb_v3_sub(way[i + 1], way[i]), to = sb_v3_sub(x, way[i]);
        double share = (double)sb_v3_dot(to, edge) / (double)sb_v3_dot(edge, edge);
        share = share < 0 ? 0 : share > 1 ? 1 : share;
        least = fmin(least, (double)sb_v3_norm(sb_v3_madd(to, (sb_real)-share, edge)));
    }
    return least;
}

/* Most of the shaft's nodes, 8 cm deep in gel that does not give way. */
static double shaft_off_way(const settings *s, double edge)
{
    scene c = scene_begin(s, 0.1, 0.012, NDL_NITINOL_083);
    const ndl_rod *rod;
    sb_vec3 way[MOST_POINTS];
    double most = 0;
    int good, count = 1;
    c.def.bevel.curvature = 8;
    good = scene_make(&c, 0.08, edge, 1e9, 0.0241);
    way[0] = sb_v3(c.def.base.x, c.def.base.y, (sb_real)c.height);
    for (int i = 0; good && count < MOST_POINTS && ndl_needle_depth(c.needle) < (sb_real)0.08; i++) {
        good = scene_step(&c, 0.02, 0.05, 0);
        if (good && ndl_needle_depth(c.needle) > 0)
            way[count++] = scene_tip(&c);
    }
    rod = good ? ndl_needle_rod(c.needle) : NULL;
    for (int i = good ? ndl_needle_entry(c.needle) : 0; good && i < ndl_rod_node_count(rod); i++)
        most = fmax(most, off_way(way, count, ndl_rod_positions(rod)[i]));
    scene_end(&c);
    return good ? most : (double)NAN;
}

/* Peak of the push through a skin of 2 N, 1 mm, at 2 cm/s; *beyond: most of it without that skin, beyond 0.5 N to cut
 * and 20 N/m of friction. */
static double skin_peak(const settings *s, double dt, int skin, double *beyond)
{
    const ndl_membrane membrane = {{-1, 0}, 2, (sb_real)0.001};
    const double speed = 0.02;
    scene c = scene_begin(s, 0.04, 0.012, NDL_STYLET_18G);
    double peak = 0;
    int good;
    *beyond = 0;
    c.friction.friction = 20, c.friction.cutting = (sb_real)0.5;
    c.def.membranes = &membrane;
    c.def.membrane_count = skin;
    good = scene_make(&c, 0.04, 0.01, 5e4, 0.0191);
    for (int i = 0; good && i < (int)(0.02 / (speed * dt)); i++) {
        good = scene_step(&c, dt, speed, 0);
        peak = fmax(peak, -(double)scene_force(&c).z);
        *beyond = fmax(*beyond, -(double)scene_force(&c).z - 0.5 - 20 * (double)ndl_needle_depth(c.needle));
    }
    scene_end(&c);
    return good ? peak : (double)NAN;
}

/* ---- charts ---------------------------------------------------------------------------------------------------- */

static void keep(settings *s, const char *study, const char *gel, double at, double value, const char *unit)
{
    printf("%-18s %-18s %9.4g %10.4g %s\n", study, gel, at, value, unit);
    fprintf(s->csv, "%s,%s,%.9g,%.9g,%s\n", study, gel, at, value, unit);
    if (!(value - value == 0))
        s->status = EXIT_SOLVE;
}

static double edges[MOST] = {20, 14.5, 10, 7.3, 5}, steps[MOST] = {40, 20, 10, 5};
static double stiff[GELS][2][MOST], solid[GELS][2][MOST], aside[GELS][MOST], off[MOST], peaks[MOST], more[MOST];

/* Of both needles in one gel, and of the needle as a solid (tests/test_needle_held.c has its cases). */
static void study_stiffness(settings *s, int gel)
{
    static const char *const words[2][GELS] = {{"nitinol in 12 kPa", "nitinol in 60 kPa", "nitinol in 240 kPa"},
                                               {"steel in 12 kPa", "steel in 60 kPa", "steel in 240 kPa"}};
    static const double young[GELS] = {12e3, 60e3, 240e3}, alone[2][GELS] = {{175, 497, 1066}, {449, 1354, 3357}};
    static const ndl_rod_preset kinds[2] = {NDL_NITINOL_083, NDL_STYLET_18G};
    for (int k = 0; k < 2; k++)
        for (int i = 0; i < s->edges; i++) {
            stiff[gel][k][i] = base_stiffness(s, kinds[k], young[gel], 1e-3 * edges[i]);
            solid[gel][k][i] = alone[k][gel];
            keep(s, "base stiffness", words[k][gel], edges[i], stiff[gel][k][i], "N/m");
        }
}

static void study_bend(settings *s, int gel)
{
    static const char *const words[GELS] = {"10 kPa", "50 kPa", "25 kPa"};
    static const double young[GELS] = {1e4, 5e4, 2.5e4};
    for (int i = 0; i < s->edges; i++) {
        aside[gel][i] = 1e3 * tip_aside(s, young[gel], 1e-3 * edges[i]);
        keep(s, "tip aside", words[gel], edges[i], aside[gel][i], "mm");
    }
}

static void study_edges(settings *s, plot *p)
{
    plot_panel *panel;
    for (int gel = 0; gel < GELS; gel++)
        if (s->all || gel == 1)
            study_stiffness(s, gel);
    for (int gel = 0; gel < GELS; gel++)
        if (s->all || gel < 2)
            study_bend(s, gel);
    for (int i = 0; i < s->edges; i++)
        keep(s, "shaft off its way", "1 GPa", edges[i], off[i] = 1e3 * shaft_off_way(s, 1e-3 * edges[i]), "mm");
    panel = plot_add_panel(p, "base pushed aside, 60 kPa", "edge (mm)", "stiffness (N/m)");
    plot_add_curve(panel, "nitinol", edges, stiff[1][0], s->edges);
    plot_add_curve(panel, "steel", edges, stiff[1][1], s->edges);
    plot_add_curve(panel, "solid nitinol", edges, solid[1][0], s->edges)->dashed = 1;
    plot_add_curve(panel, "solid steel", edges, solid[1][1], s->edges)->dashed = 1;
    panel = plot_add_panel(p, "tip after 8 cm", "edge (mm)", "aside (mm)");
    plot_add_curve(panel, "10 kPa", edges, aside[0], s->edges);
    plot_add_curve(panel, "50 kPa", edges, aside[1], s->edges);
    if (s->all)
        plot_add_curve(panel, "25 kPa", edges, aside[2], s->edges);
    panel = plot_add_panel(p, "shaft in stiff gel", "edge (mm)", "off its tip's way (mm)");
    plot_add_curve(panel, "nodes, the most", edges, off, s->edges);
}

static void study_steps(settings *s, plot *p)
{
    plot_panel *panel;
    double unused;
    int count = s->quick ? 2 : 4;
    for (int i = 0; i < count; i++) {
        keep(s, "skin", "2 N and 0.5 N", steps[i], peaks[i] = skin_peak(s, 1e-3 * steps[i], 1, &unused), "N");
        unused = skin_peak(s, 1e-3 * steps[i], 0, more + i);
        keep(s, "beyond the law", "no skin", steps[i], unused - unused == 0 ? more[i] : (double)NAN, "N");
    }
    panel = plot_add_panel(p, "puncture of a skin", "step (ms)", "peak of the push (N)");
    plot_add_curve(panel, "2 cm/s", steps, peaks, count);
    panel = plot_add_panel(p, "entry without one", "step (ms)", "beyond friction and cutting (N)");
    plot_add_curve(panel, "2 cm/s", steps, more, count);
}

static int save_chart(const settings *s, const plot *p, const char *what)
{
    char path[512];
    snprintf(path, sizeof path, "%s_%s.svg", s->out, what);
    if (plot_save_svg(p, path))
        return 1;
    fprintf(stderr, "needle_study: %s: cannot be written\n", path);
    return 0;
}

static int study(settings *s)
{
    static plot by_edge, by_step;
    char path[512];
    sb_output csv;
    int written;
    snprintf(path, sizeof path, "%s.csv", s->out);
    if (sb_output_open(&csv, path, NULL) != SB_OK) {
        fprintf(stderr, "needle_study: %s: cannot be written\n", path);
        return EXIT_USAGE;
    }
    s->csv = csv.file;
    fprintf(s->csv, "study,of,edge_mm_or_step_ms,value,unit\n");
    plot_begin(&by_edge, s->remesh ? "Needles that meshes follow" : "Held needles over the mesh's edges");
    plot_begin(&by_step, s->remesh ? "Needles that meshes follow" : "Held needles over the step");
    study_edges(s, &by_edge);
    study_steps(s, &by_step);
    written = sb_output_close(&csv, NULL) == SB_OK;
    if (!written)
        fprintf(stderr, "needle_study: %s: cannot be written\n", path);
    written = written && save_chart(s, &by_edge, "mesh") && save_chart(s, &by_step, "step");
    if (written && !s->status)
        printf("%s.csv, %s_mesh.svg and %s_step.svg written\n", s->out, s->out, s->out);
    return s->status ? s->status : written ? 0 : EXIT_USAGE;
}

static int program(int argc, char **argv)
{
    settings s = {"needle_study", 0, 0, 0, 0, 0, NULL, 0};
    option list[] = {
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &s.out, 0, 0, "writes NAME.csv, NAME_mesh.svg and NAME_step.svg"},
        {"--remesh", NULL, OPTION_FLAG, &s.remesh, NULL, NULL, 0, 0, "meshes that follow the needle (NDL_REMESH)"},
        {"--quick", NULL, OPTION_FLAG, &s.quick, NULL, NULL, 0, 0, "two meshes and two steps: seconds"},
        {"--all", NULL, OPTION_FLAG, &s.all, NULL, NULL, 0, 0, "three gels and a mesh of 5 mm edges, too: minutes"},
        {"--help", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, "this text"},
    };
    enum { OPTIONS = sizeof list / sizeof list[0] };
    if (!options_parse("needle_study", list, OPTIONS, NULL, 0, argc, argv))
        return EXIT_USAGE;
    if (s.help) {
        printf("needle_study [OPTIONS]: what of a needle in tissue depends on the mesh and on the step\n\n");
        options_print(list, OPTIONS);
        return 0;
    }
    s.edges = s.quick ? 2 : s.all ? MOST : 4;
    return study(&s);
}

int main(int argc, char **argv) { return finish("needle_study", program(argc, argv), EXIT_USAGE); }
