/* identify: moduli of a body from what was measured of it, or of a phantom with a stiff core, from indentation.
 *
 *     identify [OPTIONS] CASE READINGS [CASE READINGS ...]
 *     identify [OPTIONS] [READINGS]      identify --help lists them
 *
 * With cases: E (--young) and nu (--poisson) of regions are sought from displacements of nodes and forces on supports
 * in one or several states, see identify_case.h; each with its deviation and the share of its influence that is its
 * own.
 *
 * Without: a soft block of 5 cm with a core is pressed in at its top in several depths; its force and the places of
 * eight markers are read, with noise (Suwelack 2014, 9.2). The moduli of shell and core are sought from these readings,
 * or from those of a file, for the core's size as it is said to be and for sizes about it, since nobody knows it.
 * Written are the readings (NAME.txt, as the program reads them) and a chart of the misfit and of the moduli over the
 * size (NAME.svg). What counts is told beside each value: its deviation, and the share of its influence that is its
 * own: try
 * --force.
 *
 * READINGS: a line `depth M FX FY FZ SIGMA` (m, N) for each of the three states, and after it one `marker NODE X Y Z
 * SIGMA` (m) for each of eight markers, the same in all states. Exit status: 0, 2 wrong usage or a file, 3 a solve
 * failed or the readings do not tell. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "identify_case.h"
#include "options.h"
#include "plot.h"

enum { EXIT_USAGE = 2, EXIT_SOLVE = 3, MARKERS = 8, STATES = 3, SIZES = 7, CELLS = 8 };

typedef struct settings {
    double shell, core, size, noise;
    double sigma;
    const char *young, *poisson;
    int force_only, seed, help;
    const char *out;
} settings;

typedef struct phantom {
    sb_mesh mesh;
    sb_body *body;
    int top[128], top_count;
    sb_real depth[STATES];
    int starts[MARKERS + 1], nodes[MARKERS];
    sb_real weights[MARKERS];
    sb_mapping markers;
    sb_vec3 points[STATES][MARKERS];
    sb_measurement seen[STATES];
    sb_parameter parameters[2];
} phantom;

static const double edge = 0.05; /* m */

/* ---- the phantom ------------------------------------------------------------------------------------------------ */

/* Elements whose centre is within half of `size` (m) of the block's middle along each axis are its core. */
static int set_core(phantom *p, double size)
{
    int count = 0;
    for (int e = 0; e < p->mesh.element_count; e++) {
        sb_vec3 c = sb_v3(0, 0, 0);
        for (int a = 0; a < 8; a++)
            c = sb_v3_madd(c, (sb_real)0.125, p->mesh.nodes[p->mesh.elements[8 * e + a]]);
        p->mesh.regions[e] = fabs((double)c.x - edge / 2) < size / 2 && fabs((double)c.y - edge / 2) < size / 2 &&
                             fabs((double)c.z - edge / 2) < size / 2;
        count += p->mesh.regions[e];
    }
    return count;
}

static sb_result make_mesh(phantom *p, sb_error *error)
{
    const sb_real side = (sb_real)edge;
    sb_result result = sb_mesh_beam(SB_HEX8, CELLS, CELLS, CELLS, sb_v3(side, side, side), NULL, &p->mesh, error);
    if (result != SB_OK)
        return result;
    if (!p->mesh.regions)
        p->mesh.regions = (int *)calloc((size_t)p->mesh.element_count, sizeof(int));
    for (int i = 0; i < p->mesh.node_count; i++) {
        sb_vec3 x = p->mesh.nodes[i];
        double off = fmax(fabs((double)x.x - edge / 2), fabs((double)x.y - edge / 2));
        if ((double)x.z > 0.999 * edge && off < 0.2 * edge && p->top_count < 128)
            p->top[p->top_count++] = i;
    }
    return p->mesh.regions ? SB_OK : SB_ERROR_MEMORY;
}

/* Markers at nodes between the core and the surface. */
static void place_markers(phantom *p)
{
    for (int k = 0; k < MARKERS; k++) {
        sb_vec3 wanted = sb_v3((sb_real)(edge * (k & 1 ? 0.8 : 0.2)), (sb_real)(edge * (k & 2 ? 0.75 : 0.25)),
                               (sb_real)(edge * (k & 4 ? 0.85 : 0.4)));
        sb_real least = SB_REAL_MAX;
        for (int i = 0; i < p->mesh.node_count; i++) {
            sb_real away = sb_v3_norm(sb_v3_sub(p->mesh.nodes[i], wanted));
            if (away < least) {
                least = away;
                p->nodes[k] = i;
            }
        }
        p->starts[k + 1] = k + 1;
        p->weights[k] = 1;
    }
    p->markers.row_count = MARKERS;
    p->markers.row_start = p->starts;
    p->markers.nodes = p->nodes;
    p->markers.weights = p->weights;
}

/* A body with a core of this size and these moduli (Pa), held at its foot. */
static sb_result make_body(phantom *p, double size, double shell, double core, sb_error *error)
{
    sb_body_def def = sb_default_body_def();
    sb_region_material inner;
    sb_result result;
    if (set_core(p, size) == 0)
        return SB_ERROR_ARGUMENT;
    inner.region = 1;
    inner.material = sb_material_neo_hookean((sb_real)core, (sb_real)0.42, 1000);
    def.mesh = &p->mesh;
    def.material = sb_material_neo_hookean((sb_real)shell, (sb_real)0.42, 1000);
    def.region_materials = &inner;
    def.region_material_count = 1;
    sb_body_destroy(p->body);
    p->body = NULL;
    result = sb_body_create(&def, &p->body, error);
    for (int i = 0; i < p->mesh.node_count && result == SB_OK; i++)
        if (p->mesh.nodes[i].z <= 0)
            result = sb_body_fix_nodes(p->body, &i, 1, SB_XYZ);
    return result;
}

static sb_result press(void *user, int state, const sb_real *free_values, sb_body *body, sb_error *error)
{
    const phantom *p = (const phantom *)user;
    const sb_vec3 down = sb_v3(0, 0, -p->depth[state]);
    (void)free_values, (void)error;
    return sb_body_prescribe(body, p->top, p->top_count, SB_XYZ, &down, 1);
}

/* ---- readings ---------------------------------------------------------------------------------------------------- */

/* A number of the normal distribution (Box and Muller). */
static double draw(unsigned long long *state)
{
    double u[2];
    for (int i = 0; i < 2; i++) {
        *state = *state * 6364136223846793005ULL + 1442695040888963407ULL;
        u[i] = ((double)(*state >> 11) + 0.5) / 9007199254740992.0;
    }
    return sqrt(-2 * log(u[0])) * cos(6.283185307179586 * u[1]);
}

static sb_vec3 add_noise(sb_vec3 v, sb_real sigma, unsigned long long *state)
{
    v.x += sigma * (sb_real)draw(state);
    v.y += sigma * (sb_real)draw(state);
    v.z += sigma * (sb_real)draw(state);
    return v;
}

/* What a tracker and a force gauge would read of the phantom as it is. */
static sb_result measure(phantom *p, const settings *s, sb_error *error)
{
    unsigned long long state = (unsigned long long)s->seed;
    for (int k = 0; k < STATES; k++) {
        sb_measurement *m = &p->seen[k];
        sb_step_info info;
        sb_result result;
        p->depth[k] = (sb_real)(0.004 * (k + 1));
        result = press(p, k, NULL, p->body, error);
        if (result == SB_OK)
            result = sb_body_solve_static(p->body, NULL, &info);
        if (result != SB_OK)
            return result;
        sb_mapping_apply(&p->markers, sb_body_positions(p->body), p->points[k]);
        for (int i = 0; i < p->top_count; i++)
            m->force = sb_v3_add(m->force, sb_body_reactions(p->body)[p->top[i]]);
        m->sigma_force = (sb_real)(s->noise * 0.02) * sb_v3_norm(m->force);
        m->sigma_point = (sb_real)(s->noise * 1e-4);
        m->force = add_noise(m->force, m->sigma_force, &state);
        for (int j = 0; j < MARKERS; j++)
            p->points[k][j] = add_noise(p->points[k][j], m->sigma_point, &state);
    }
    return SB_OK;
}

static int write_readings(const phantom *p, const char *path)
{
    FILE *file = fopen(path, "w");
    if (!file)
        return 0;
    for (int k = 0; k < STATES; k++) {
        const sb_measurement *m = &p->seen[k];
        fprintf(file, "depth %.9g %.9g %.9g %.9g %.9g\n", (double)p->depth[k], (double)m->force.x, (double)m->force.y,
                (double)m->force.z, (double)m->sigma_force);
        for (int j = 0; j < MARKERS; j++)
            fprintf(file, "marker %d %.9g %.9g %.9g %.9g\n", p->nodes[j], (double)p->points[k][j].x,
                    (double)p->points[k][j].y, (double)p->points[k][j].z, (double)m->sigma_point);
    }
    return fclose(file) == 0;
}

static int are_finite(const double *values, int count)
{
    for (int i = 0; i < count; i++)
        if (!isfinite(values[i]))
            return 0;
    return 1;
}

/* One state of a file; 0 where it is not that. The markers are the same in all. */
static int read_state(phantom *p, int k, FILE *file)
{
    sb_measurement *m = &p->seen[k];
    double v[5];
    if (fscanf(file, " depth %lf %lf %lf %lf %lf", v, v + 1, v + 2, v + 3, v + 4) != 5 || !are_finite(v, 5) ||
        !(v[0] > 0 && v[0] < edge / 2 && v[4] > 0))
        return 0;
    p->depth[k] = (sb_real)v[0];
    m->force = sb_v3((sb_real)v[1], (sb_real)v[2], (sb_real)v[3]);
    m->sigma_force = (sb_real)v[4];
    for (int j = 0; j < MARKERS; j++) {
        int node;
        if (fscanf(file, " marker %d %lf %lf %lf %lf", &node, v, v + 1, v + 2, v + 3) != 5 || node < 0 ||
            node >= p->mesh.node_count || (k > 0 && node != p->nodes[j]) || !are_finite(v, 4) || !(v[3] > 0))
            return 0;
        p->nodes[j] = node;
        p->points[k][j] = sb_v3((sb_real)v[0], (sb_real)v[1], (sb_real)v[2]);
        m->sigma_point = (sb_real)v[3];
    }
    return 1;
}

static int read_readings(phantom *p, const char *path)
{
    FILE *file = fopen(path, "r");
    int good = file != NULL;
    char more;
    for (int k = 0; k < STATES && good; k++)
        good = read_state(p, k, file);
    good = good && fscanf(file, " %c", &more) != 1;
    if (file)
        fclose(file);
    return good;
}

static void connect(phantom *p, const settings *s)
{
    for (int k = 0; k < STATES; k++) {
        p->seen[k].rows = s->force_only ? NULL : &p->markers;
        p->seen[k].points = p->points[k];
        p->seen[k].force_nodes = p->top;
        p->seen[k].force_count = p->top_count;
    }
    p->parameters[0].kind = p->parameters[1].kind = SB_PARAMETER_YOUNG;
    p->parameters[1].region = 1;
}

/* ---- what they tell ------------------------------------------------------------------------------------------------
 */

typedef struct answer {
    sb_real values[2], deviations[2], shares[2];
    sb_identify_info info;
} answer;

static sb_result seek(phantom *p, double size, answer *a, sb_error *error)
{
    sb_identify_def def = sb_default_identify_def();
    sb_result result = make_body(p, size, 3000, 3000, error);
    if (result != SB_OK)
        return result;
    a->values[0] = a->values[1] = 3000;
    def.body = p->body;
    def.parameters = p->parameters;
    def.count = 2;
    def.state_count = STATES;
    def.measurements = p->seen;
    def.apply = press;
    def.user = p;
    return sb_identify(&def, a->values, a->deviations, a->shares, &a->info, error);
}

static void tell(const answer *a)
{
    static const char *const names[2] = {"shell", "core"};
    for (int k = 0; k < 2; k++)
        printf("%s: %.0f Pa, deviation %.0f Pa, own share %.3f\n", names[k], (double)a->values[k],
               (double)a->deviations[k], (double)a->shares[k]);
    printf("chi2 %.1f of %d readings, %d steps, %d solves\n", a->info.chi2, a->info.readings, a->info.iterations,
           a->info.solves);
    printf("least certain together: %s (0 shell, 1 core)\n", a->info.hidden);
    if (a->info.weakest < (sb_real)0.1)
        printf("these readings hardly tell shell and core apart: believe neither value alone\n");
}

static int draw_chart(const char *path, const double *sizes, double values[3][SIZES], int count)
{
    plot p;
    plot_panel *panel;
    plot_begin(&p, "A phantom's moduli, over the size that its core is said to have");
    panel = plot_add_panel(&p, "misfit", "size of the core (mm)", "chi2 / (readings - 2)");
    plot_add_curve(panel, "misfit", sizes, values[0], count);
    panel = plot_add_panel(&p, "what is found", "size of the core (mm)", "Young's modulus (Pa)");
    plot_add_curve(panel, "shell", sizes, values[1], count);
    plot_add_curve(panel, "core", sizes, values[2], count);
    return plot_save_svg(&p, path);
}

/* The same for other sizes of the core: the size with the least misfit is the one that was pressed. */
static void scan(phantom *p, const char *path, int *written, sb_error *error)
{
    const double cell = edge / (double)CELLS;
    double sizes[SIZES], values[3][SIZES];
    int count = 0;
    for (int k = 0; k < SIZES; k += 2) { /* one layer of elements more on each side */
        answer a;
        double size = cell * (k + 1.5);
        sb_result result = size < edge - cell ? seek(p, size, &a, error) : SB_ERROR_ARGUMENT;
        if (result != SB_OK)
            continue;
        sizes[count] = 1e3 * size;
        values[0][count] = a.info.chi2 / (a.info.readings - 2);
        values[1][count] = (double)a.values[0];
        values[2][count++] = (double)a.values[1];
        printf("core of %4.1f mm: chi2 per reading %6.2f, shell %.0f Pa, core %.0f Pa\n", sizes[count - 1],
               values[0][count - 1], values[1][count - 1], values[2][count - 1]);
    }
    *written = count > 0 && draw_chart(path, sizes, values, count);
}

/* ---- cases ------------------------------------------------------------------------------------------------------- */

static int read_cases(identify_cases *all, const settings *s, const char *const *paths)
{
    for (int i = 0; paths[i]; i += 2) {
        if (!paths[i + 1])
            return identify_fail(all, paths[i], 0, "a case needs its readings after it");
        if (!identify_add_state(all, paths[i], paths[i + 1], (sb_real)s->sigma))
            return 0;
    }
    if ((*s->young && !identify_add_values(all, SB_PARAMETER_YOUNG, s->young)) ||
        (*s->poisson && !identify_add_values(all, SB_PARAMETER_POISSON, s->poisson)))
        return 0;
    return all->count > 0 ? identify_make_body(all)
                          : identify_fail(all, paths[0], 0, "nothing is sought: --young or --poisson");
}

static void tell_values(const identify_cases *all, const sb_real *starts, const sb_real *deviations,
                        const sb_real *shares, const sb_identify_info *info)
{
    for (int k = 0; k < all->count; k++) {
        int of_young = all->parameters[k].kind == SB_PARAMETER_YOUNG;
        printf("value %d: %s of region %d %.6g%s from %.6g, deviation %.2g, own share %.3f\n", k,
               of_young ? "Young's modulus" : "Poisson's ratio", all->parameters[k].region, (double)all->values[k],
               of_young ? " Pa" : "", (double)starts[k], (double)deviations[k], (double)shares[k]);
    }
    printf("chi2 %.1f of %d readings, %d steps, %d solves\n", info->chi2, info->readings, info->iterations,
           info->solves);
    printf("least certain together: %s\n", info->hidden);
    if (info->weakest < (sb_real)0.1)
        printf("these readings hardly tell the values apart: believe none of them alone\n");
    if (info->warnings & SB_IDENTIFY_MISFIT)
        printf("the readings are %s than their sigmas say: the model, or a sigma, is wrong\n",
               info->chi2 > info->readings ? "farther off" : "nearer");
    if (info->warnings & SB_IDENTIFY_LOCKS)
        printf("these elements lock near incompressibility: moduli come out too small\n");
}

static int run_cases(const settings *s, const char *const *paths)
{
    identify_cases *all = (identify_cases *)calloc(1, sizeof *all);
    sb_real starts[IDENTIFY_VALUES], deviations[IDENTIFY_VALUES], shares[IDENTIFY_VALUES];
    sb_identify_info info;
    int status = EXIT_USAGE;
    if (!all)
        return EXIT_SOLVE;
    if (read_cases(all, s, paths)) {
        memcpy(starts, all->values, sizeof starts);
        status = identify_solve(all, deviations, shares, &info) == SB_OK ? 0 : EXIT_SOLVE;
    }
    if (status == 0)
        tell_values(all, starts, deviations, shares, &info);
    else if (all->state_count > 0 && all->states[all->state_count - 1].file.faults.text)
        fputs(all->states[all->state_count - 1].file.faults.text, stderr); /* all mistakes of the file */
    else
        fprintf(stderr, "identify: %s\n", all->message);
    identify_free(all);
    free(all);
    return status;
}

static int is_case(const char *path)
{
    return foreign_ends_in(path, "case") || foreign_ends_in(path, "inp") || foreign_ends_in(path, "feb") ||
           foreign_ends_in(path, "msml.xml");
}

/* ---- the program ------------------------------------------------------------------------------------------------- */

static int complain(const char *what, const sb_error *error)
{
    fprintf(stderr, "identify: %s: %s\n", what, error->message);
    return EXIT_SOLVE;
}

static int run(phantom *p, const settings *s, const char *readings)
{
    char path[1024];
    sb_error error;
    answer a;
    int written = 1;
    memset(&error, 0, sizeof error);
    if (make_mesh(p, &error) != SB_OK)
        return complain("the phantom", &error);
    place_markers(p);
    if (readings && !read_readings(p, readings)) {
        fprintf(stderr, "identify: %s cannot be read, or holds no readings of this phantom\n", readings);
        return EXIT_USAGE;
    }
    if (!readings && (make_body(p, s->size, s->shell, s->core, &error) != SB_OK || measure(p, s, &error) != SB_OK))
        return complain("the phantom", &error);
    connect(p, s);
    snprintf(path, sizeof path, "%s.txt", s->out);
    if (!readings)
        written = write_readings(p, path);
    if (written && seek(p, s->size, &a, &error) != SB_OK)
        return complain("the readings", &error);
    if (written) {
        snprintf(path, sizeof path, "%s.svg", s->out);
        tell(&a);
        scan(p, path, &written, &error);
    }
    if (written)
        return 0;
    fprintf(stderr, "identify: %s cannot be written\n", path);
    return EXIT_USAGE;
}

static int program(int argc, char **argv)
{
    settings s = {4000, 12000, 0.021, 1, 1e-4, "", "", 0, 1, 0, "identify"};
    const char *files[2 * IDENTIFY_STATES + 1] = {NULL};
    phantom *p;
    int status;
    const option options[] = {
        {"--young", "LIST", OPTION_TEXT, NULL, NULL, &s.young, 0, 0,
         "of cases: regions like 1,2, or all, whose E is sought"},
        {"--poisson", "LIST", OPTION_TEXT, NULL, NULL, &s.poisson, 0, 0, "and whose nu is"},
        {"--sigma", "M", OPTION_NUMBER, NULL, &s.sigma, NULL, 1e-12, 1e3,
         "deviation of coordinates whose file tells none"},
        {"--shell", "PA", OPTION_NUMBER, NULL, &s.shell, NULL, 100, 1e6, "Young's modulus of the shell"},
        {"--core", "PA", OPTION_NUMBER, NULL, &s.core, NULL, 100, 1e6, "and of the core"},
        {"--size", "M", OPTION_NUMBER, NULL, &s.size, NULL, 0.0063, 0.0437, "edge of the core, also for the search"},
        {"--noise", "X", OPTION_NUMBER, NULL, &s.noise, NULL, 1e-3, 100, "times 2 % of the force and 0.1 mm"},
        {"--seed", "N", OPTION_INTEGER, &s.seed, NULL, NULL, 0, 1e6, "of the noise"},
        {"--force", NULL, OPTION_FLAG, &s.force_only, NULL, NULL, 0, 0, "the force alone, without markers"},
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &s.out, 0, 0, "NAME.txt and NAME.svg are written"},
        {"--help", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, "this text"},
    };
    const int count = (int)(sizeof options / sizeof options[0]);
    if (!options_parse("identify", options, count, files, 2 * IDENTIFY_STATES, argc, argv))
        return EXIT_USAGE;
    if (s.help) {
        printf("usage: identify [OPTIONS] CASE READINGS [CASE READINGS ...]\n       identify [OPTIONS] [READINGS]\n");
        options_print(options, count);
        return 0;
    }
    if (files[0] && is_case(files[0]))
        return run_cases(&s, files);
    if (files[1]) {
        fprintf(stderr, "identify: %s is no case\n", files[0]);
        return EXIT_USAGE;
    }
    p = (phantom *)calloc(1, sizeof *p);
    if (!p)
        return EXIT_SOLVE;
    status = run(p, &s, files[0]);
    sb_body_destroy(p->body);
    sb_mesh_free(&p->mesh);
    free(p);
    return status;
}

int main(int argc, char **argv) { return finish("identify", program(argc, argv), EXIT_USAGE); }
