/* viscoelastic: relaxation and creep of liver models from the literature.
 *
 *     viscoelastic [OPTIONS]      viscoelastic --help lists them
 *
 * A cube is stretched within moments and held: its stress relaxes. It is loaded within moments and left: it creeps.
 * Written are a chart (SVG) and the numbers (CSV). The models are those of tables 4.1 and 4.2 of Suwelack, Real-time
 * biomechanical modeling for intraoperative soft tissue registration (2014). Exit status: 0, 2 wrong usage or a file
 * that cannot be written, 3 a step failed or memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "options.h"
#include "plot.h"

enum { EXIT_USAGE = 2, EXIT_SOLVE = 3, RAMP_STEPS = 10, MODELS = 4 };

typedef struct settings {
    double stretch, load, ramp, end; /* -, Pa, s, s */
    int points;                      /* time steps after the ramp */
    const char *out;                 /* NAME.svg and NAME.csv */
    int help;
} settings;

typedef struct model {
    const char *name;
    sb_preset preset;
    double *stress, *stretched; /* [points of time] Pa and - */
} model;

/* ---- the specimen ---------------------------------------------------------------------------------------------- */

/* A cube of 0.1 mm: so small that inertia has no say. */
static const double edge = 1e-4;
static const double density = 1060; /* kg/m^3 */

static int complain(const char *what, const sb_error *error)
{
    fprintf(stderr, "viscoelastic: %s: %s\n", what, error->message);
    return EXIT_SOLVE;
}

/* Nodes of the specimen whose coordinate along an axis is `at` (m); returns how many. */
static int nodes_at(const sb_mesh *mesh, int axis, double at, int *nodes)
{
    int count = 0;
    for (int i = 0; i < mesh->node_count; i++) {
        sb_vec3 x = mesh->nodes[i];
        double coordinate = (double)(axis == 0 ? x.x : axis == 1 ? x.y : x.z);
        if (fabs(coordinate - at) < 0.25 * edge)
            nodes[count++] = i;
    }
    return count;
}

/* The cube, free to move sideways: three faces slide on walls through the origin. */
static sb_result make_specimen(const model *m, sb_mesh *mesh, sb_body **body, sb_error *error)
{
    sb_body_def def = sb_default_body_def();
    sb_vec3 size = sb_v3((sb_real)edge, (sb_real)edge, (sb_real)edge);
    sb_result result = sb_mesh_beam(SB_HEX8, 1, 1, 1, size, NULL, mesh, error);
    if (result != SB_OK)
        return result;
    def.mesh = mesh;
    def.material = sb_material_preset(m->preset, (sb_real)density);
    def.damping_stiffness = 0; /* the presets' own relaxation is to be seen, nothing else */
    def.newton_tolerance = (sb_real)1e-8;
    result = sb_body_create(&def, body, error);
    for (int axis = 0; axis < 3 && result == SB_OK; axis++) {
        int nodes[8], count = nodes_at(mesh, axis, 0, nodes);
        result = sb_body_fix_nodes(*body, nodes, count, 1 << axis);
    }
    return result;
}

/* ---- the two experiments --------------------------------------------------------------------------------------- */

/* Times (s): an even ramp, then evenly spaced on a logarithmic axis. */
static double time_of(const settings *s, int i)
{
    if (i <= RAMP_STEPS)
        return s->ramp * i / (int)RAMP_STEPS;
    return s->ramp * pow(s->end / s->ramp, (double)(int)(i - RAMP_STEPS) / (double)s->points);
}

/* Nominal stress (Pa) that holds the top where it is. */
static double held_stress(const sb_body *body, const int *top, int count)
{
    double force = 0;
    for (int i = 0; i < count; i++)
        force += (double)sb_body_reactions(body)[top[i]].z;
    return force / (edge * edge);
}

/* Steps through one experiment. stretch > 0: the top is stretched by it and held; otherwise the top is pulled by
 * load (Pa on the undeformed area). values[count] receives stress (Pa) or stretch. */
static int run(const settings *s, const model *m, int relaxation, int count, double *values)
{
    sb_mesh mesh;
    sb_body *body = NULL;
    sb_error error;
    sb_step_info info;
    int top[8], top_count, status = 0;
    memset(&mesh, 0, sizeof mesh);
    memset(&error, 0, sizeof error);
    if (make_specimen(m, &mesh, &body, &error) != SB_OK)
        status = complain(m->name, &error);
    top_count = status ? 0 : nodes_at(&mesh, 2, edge, top);
    values[0] = relaxation ? 0 : 1;
    for (int i = 1; i < count && !status; i++) {
        double share = i < RAMP_STEPS ? i / (double)RAMP_STEPS : 1, dt = time_of(s, i) - time_of(s, i - 1);
        sb_vec3 way = sb_v3(0, 0, (sb_real)(share * (s->stretch - 1) * edge));
        sb_vec3 force = sb_v3(0, 0, (sb_real)(share * s->load * edge * edge / top_count));
        sb_body_clear_loads(body);
        sb_result result = relaxation ? sb_body_prescribe(body, top, top_count, SB_Z, &way, 1)
                                      : sb_body_add_forces(body, top, top_count, &force, 1);
        if (result == SB_OK)
            result = sb_body_step(body, (sb_real)dt, &info);
        if (result != SB_OK)
            status = complain(m->name, &info.error);
        values[i] =
            relaxation ? held_stress(body, top, top_count) : 1 + (double)sb_body_displacements(body)[top[0]].z / edge;
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return status;
}

/* ---- what comes out -------------------------------------------------------------------------------------------- */

/* NAME and an ending; 0 when that is too long. */
static int output_path(char *path, size_t size, const char *name, const char *ending)
{
    return snprintf(path, size, "%s%s", name, ending) < (int)size;
}

static int write_numbers(const char *path, const model *models, const double *times, int count)
{
    sb_output out;
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return 0;
    fputs("time_s", out.file);
    for (int m = 0; m < MODELS; m++)
        fprintf(out.file, ",\"%s: stress held (Pa)\",\"%s: stretch under load\"", models[m].name, models[m].name);
    for (int i = 0; i < count; i++) {
        fprintf(out.file, "\n%.9g", times[i]);
        for (int m = 0; m < MODELS; m++)
            fprintf(out.file, ",%.9g,%.9g", models[m].stress[i], models[m].stretched[i]);
    }
    fputc('\n', out.file);
    return sb_output_close(&out, NULL) == SB_OK;
}

static int write_chart(const char *path, const settings *s, const model *models, const double *times, int count)
{
    char relaxation[80], creep[80];
    plot p;
    plot_panel *panel;
    snprintf(relaxation, sizeof relaxation, "Relaxation: held at a stretch of %g", s->stretch);
    snprintf(creep, sizeof creep, "Creep: under %g Pa", s->load);
    plot_begin(&p, "Liver models: what is left of a stress, and how far a load gets");
    panel = plot_add_panel(&p, relaxation, "time (s)", "nominal stress (Pa)");
    panel->log_x = 1;
    for (int m = 0; m < MODELS; m++)
        plot_add_curve(panel, models[m].name, times, models[m].stress, count);
    panel = plot_add_panel(&p, creep, "time (s)", "stretch");
    panel->log_x = 1;
    for (int m = 0; m < MODELS; m++)
        plot_add_curve(panel, models[m].name, times, models[m].stretched, count);
    return plot_save_svg(&p, path);
}

static void print_table(const settings *s, const model *models, int count)
{
    int last = count - 1;
    printf("%-26s %34s %30s\n", "", "stress at a held stretch (Pa)", "stretch under load");
    printf("%-26s %9.3g s %9.3g s %10s %15.3g s %9.3g s\n", "model", s->ramp, s->end, "left", s->ramp, s->end);
    for (int m = 0; m < MODELS; m++) {
        const double *stress = models[m].stress, *stretched = models[m].stretched;
        double left = stress[RAMP_STEPS] != 0 ? 100 * stress[last] / stress[RAMP_STEPS] : 100;
        printf("%-26s %11.2f %11.2f %9.1f %% %17.4f %11.4f\n", models[m].name, stress[RAMP_STEPS], stress[last], left,
               stretched[RAMP_STEPS], stretched[last]);
    }
}

static int write_all(const settings *s, const model *models, const double *times, int count)
{
    char chart[1024], numbers[1024];
    if (!output_path(chart, sizeof chart, s->out, ".svg") || !output_path(numbers, sizeof numbers, s->out, ".csv")) {
        fprintf(stderr, "viscoelastic: %s is too long a name\n", s->out);
        return EXIT_USAGE;
    }
    if (!write_chart(chart, s, models, times, count) || !write_numbers(numbers, models, times, count)) {
        fprintf(stderr, "viscoelastic: %s.svg or .csv cannot be written\n", s->out);
        return EXIT_USAGE;
    }
    print_table(s, models, count);
    printf("\nchart    %s\nnumbers  %s\n", chart, numbers);
    return 0;
}

/* ---- the program ----------------------------------------------------------------------------------------------- */

static int study(const settings *s)
{
    model models[MODELS] = {
        {"Jordan et al. 2009", SB_LIVER_JORDAN, NULL, NULL},
        {"Raghunathan et al. 2010", SB_LIVER_RAGHUNATHAN, NULL, NULL},
        {"Kim et al. 2005", SB_LIVER_KIM, NULL, NULL},
        {"simplified, elastic", SB_LIVER_NEO_HOOKEAN, NULL, NULL},
    };
    int count = 1 + RAMP_STEPS + s->points, status = 0;
    double *memory = (double *)calloc((size_t)count, (1 + 2 * MODELS) * sizeof *memory), *times = memory;
    if (!memory) {
        fprintf(stderr, "viscoelastic: out of memory\n");
        return EXIT_SOLVE;
    }
    for (int i = 0; i < count; i++)
        times[i] = time_of(s, i);
    for (int m = 0; m < MODELS && !status; m++) {
        models[m].stress = memory + (size_t)count * (size_t)(1 + 2 * m);
        models[m].stretched = models[m].stress + count;
        status = run(s, models + m, 1, count, models[m].stress);
        if (!status)
            status = run(s, models + m, 0, count, models[m].stretched);
    }
    if (!status)
        status = write_all(s, models, times, count);
    free(memory);
    return status;
}

static int program(int argc, char **argv)
{
    settings s = {1.1, 50, 0.01, 1000, 120, "viscoelastic", 0};
    const option options[] = {
        {"--stretch", "L", OPTION_NUMBER, NULL, &s.stretch, NULL, 0.5, 2, "the stretch that is held"},
        {"--load", "PA", OPTION_NUMBER, NULL, &s.load, NULL, -1e4, 1e4, "the load (Pa) that stays"},
        {"--ramp", "S", OPTION_NUMBER, NULL, &s.ramp, NULL, 1e-3, 1e3, "time (s) in which either comes about"},
        {"--end", "S", OPTION_NUMBER, NULL, &s.end, NULL, 1e-2, 1e7, "time (s) of the last point, after the ramp"},
        {"--points", "N", OPTION_INTEGER, &s.points, NULL, NULL, 10, 1e5, "time steps from ramp to end"},
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &s.out, 0, 0, "writes NAME.svg and NAME.csv"},
        {"--help", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, "this text"},
        {"-h", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, NULL},
    };
    const int count = (int)(sizeof options / sizeof options[0]);
    if (!options_parse("viscoelastic", options, count, NULL, 0, argc, argv))
        return EXIT_USAGE;
    if (s.help) {
        printf("usage: viscoelastic [OPTIONS]\n\n"
               "Relaxation and creep curves of liver models from the literature, as a chart and as numbers.\n\n");
        options_print(options, count);
        return 0;
    }
    if (!(s.end > s.ramp)) {
        options_complain("viscoelastic", "--end", "must be after --ramp");
        return EXIT_USAGE;
    }
    return study(&s);
}

int main(int argc, char **argv) { return finish("viscoelastic", program(argc, argv), EXIT_USAGE); }
