/* drop: organs fall on a floor and on each other, and come to rest.
 *
 *     drop [ORGAN] [OPTIONS]      drop --help lists the options
 *
 * Without a file round organs of different shapes are made. All lie in one body, as the parts of its mesh, turned at
 * random and one above the other, so that each falls on those before it; what they are thrown down with can be chosen.
 * They touch each other (and, with --self, themselves) and the floor, a plane. Written are the course of energy and
 * overlap (CSV), a picture of the end, and on request a series for ParaView. Exit status: 0, 2 wrong usage or a file
 * that cannot be read or written, 3 a step failed or memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "options.h"
#include "organ_scene.h"

#define REAL(x) ((sb_real)(x)) /* everything here computes in double, the body in sb_real */

static const char *const program_name = "drop";
static const double gravity = 9.81; /* m/s^2 */
static const double density = 1000; /* kg/m^3 */
static const double still = 1e-4;   /* m/s, root of the mean square: slower than this is rest */
enum { MOST_ORGANS = 40 };

typedef struct settings {
    const char *organ, *out, *series;
    double scale, young, poisson, friction, speed, seconds, rate;
    int count, cells, seed, self, help;
} settings;

/* What a step ended with. */
typedef struct moment {
    double time, kinetic, deepest, milliseconds; /* s, J, m, ms */
    double lift;                                 /* N, of the floor */
    int touching;                                /* samples of organs that press on each other */
} moment;

typedef struct work {
    const settings *set;
    organ scene;
    int floor;
    double weight;     /* N, of all */
    double size;       /* m, of the largest organ */
    moment *moments;   /* [steps] */
    int steps, rested; /* the step from which on all is still, or -1 */
} work;

/* ---- organs ---------------------------------------------------------------------------------------------------- */

/* A cube becomes nearly a ball, then an organ's three widths, and one end thinner than the other. */
static sb_vec3 rounded(sb_vec3 cube, const double widths[3], double taper)
{
    double x = 2 * (double)cube.x - 1, y = 2 * (double)cube.y - 1, z = 2 * (double)cube.z - 1, round = 0.8;
    double bx = x * sqrt(1 - y * y / 2 - z * z / 2 + y * y * z * z / 3);
    double by = y * sqrt(1 - z * z / 2 - x * x / 2 + z * z * x * x / 3);
    double bz = z * sqrt(1 - x * x / 2 - y * y / 2 + x * x * y * y / 3);
    double thin;
    x += round * (bx - x), y += round * (by - y), z += round * (bz - z);
    thin = 1 - taper * (0.5 + 0.5 * x);
    return sb_v3(REAL(0.5 * widths[0] * x), REAL(0.5 * widths[1] * thin * y), REAL(0.5 * widths[2] * thin * z));
}

static int make_organ(work *w, unsigned long long *seed, sb_mesh *mesh)
{
    double widths[3], taper = 0.5 * organ_chance(seed);
    sb_error error;
    for (int k = 0; k < 3; k++)
        widths[k] = 0.04 + 0.04 * organ_chance(seed);
    if (sb_mesh_beam(SB_TET4, w->set->cells, w->set->cells, w->set->cells, sb_v3(1, 1, 1), NULL, mesh, &error) != SB_OK)
        return organ_complain_of(&w->scene, "an organ", &error, ORGAN_USAGE);
    for (int i = 0; i < mesh->node_count; i++)
        mesh->nodes[i] = rounded(mesh->nodes[i], widths, taper);
    return 0;
}

/* Turns the mesh at random, and puts it above `height`, about the middle; *top: how high it reaches (m). */
static void place_organ(work *w, unsigned long long *seed, double height, sb_mesh *mesh, double *top)
{
    sb_vec3 low, high, middle, axis;
    sb_quat turn;
    double size, gap;
    axis.x = REAL(6 * organ_chance(seed) - 3), axis.y = REAL(6 * organ_chance(seed) - 3),
    axis.z = REAL(6 * organ_chance(seed) - 3);
    turn = sb_quat_from_rotation_vector(axis);
    for (int i = 0; i < mesh->node_count; i++)
        mesh->nodes[i] = sb_quat_rotate(turn, mesh->nodes[i]);
    sb_mesh_bounds(mesh, &low, &high);
    size = (double)sb_v3_norm(sb_v3_sub(high, low));
    gap = 0.05 * size;
    middle = sb_v3_scale(REAL(0.5), sb_v3_add(low, high));
    middle.x += REAL(0.15 * size * (organ_chance(seed) - 0.5));
    middle.y += REAL(0.15 * size * (organ_chance(seed) - 0.5));
    middle.z = low.z - REAL(height + gap);
    for (int i = 0; i < mesh->node_count; i++)
        mesh->nodes[i] = sb_v3_sub(mesh->nodes[i], middle);
    *top = height + gap + (double)(high.z - low.z);
    w->size = fmax(w->size, size);
}

/* One organ after the other joins the mesh. */
static int make_mesh(work *w)
{
    const settings *s = w->set;
    unsigned long long seed = (unsigned long long)s->seed;
    double top = 0;
    sb_mesh file;
    sb_error error;
    int status = 0;
    w->scene = organ_named(program_name);
    if (s->organ && (status = organ_load(&w->scene, s->organ, s->scale)) != 0)
        return status;
    file = w->scene.mesh;
    memset(&w->scene.mesh, 0, sizeof w->scene.mesh);
    for (int k = 0; k < s->count && !status; k++) {
        sb_mesh one;
        sb_result result = SB_OK;
        memset(&one, 0, sizeof one);
        if (s->organ)
            result = sb_mesh_copy(&file, NULL, &one, &error);
        else
            status = make_organ(w, &seed, &one);
        if (result == SB_OK && !status) {
            place_organ(w, &seed, top, &one, &top);
            if (k == 0) {
                w->scene.mesh = one;
                memset(&one, 0, sizeof one);
            } else {
                result = sb_mesh_append(&w->scene.mesh, &one, &error);
            }
        }
        if (result != SB_OK)
            status = organ_complain_of(&w->scene, "an organ", &error, ORGAN_USAGE);
        sb_mesh_free(&one);
    }
    sb_mesh_free(&file);
    return status ? status : organ_make_skin(&w->scene);
}

static int make_scene(work *w)
{
    const settings *s = w->set;
    sb_body_def body = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    sb_tool_def floor_def = sb_default_tool_def();
    sb_vec3 *velocities;
    int status;
    body.material = sb_material_corotated(REAL(s->young), REAL(s->poisson), REAL(density));
    body.gravity = sb_v3(0, 0, REAL(-gravity));
    body.damping_stiffness = REAL(0.02);
    contact.pairs = SB_CONTACT_ORGANS | (s->self ? SB_CONTACT_SELF : 0);
    contact.pair_friction = REAL(s->friction);
    floor_def.shape = SB_TOOL_PLANE;
    floor_def.friction = REAL(s->friction);
    status = organ_make_body(&w->scene, &body, &contact);
    if (!status)
        status = organ_add_tool(&w->scene, &floor_def, &w->floor);
    if (status)
        return status;
    w->weight = (double)sb_body_mass(w->scene.body) * gravity;
    velocities = w->scene.places;
    for (int i = 0; i < w->scene.mesh.node_count; i++)
        velocities[i] = sb_v3(0, 0, REAL(-s->speed));
    sb_body_set_velocities(w->scene.body, velocities);
    return 0;
}

/* ---- falling --------------------------------------------------------------------------------------------------- */

static moment look(work *w)
{
    sb_contact_info info = sb_contact_get_info(w->scene.contact);
    sb_wrench wrench;
    sb_energy energy;
    moment m;
    memset(&m, 0, sizeof m);
    sb_body_energy(w->scene.body, &energy);
    sb_contact_wrench(w->scene.contact, w->floor, &wrench);
    m.kinetic = (double)energy.kinetic;
    m.deepest = (double)info.deepest;
    m.touching = info.touching;
    m.lift = -(double)wrench.force.z;
    m.milliseconds = 1e3 * w->scene.seconds;
    return m;
}

static int fall(work *w)
{
    const settings *s = w->set;
    double dt = 1 / s->rate, mass = (double)sb_body_mass(w->scene.body);
    int status = 0;
    w->steps = (int)ceil(s->seconds * s->rate);
    w->rested = -1;
    w->moments = (moment *)calloc((size_t)w->steps, sizeof *w->moments);
    if (!w->moments)
        return organ_complain_memory(&w->scene);
    for (int i = 0; i < w->steps && !status; i++) {
        char words[64];
        status = organ_step(&w->scene, dt);
        if (status)
            break;
        w->moments[i] = look(w);
        w->moments[i].time = (i + 1) * dt;
        if (sqrt(2 * w->moments[i].kinetic / mass) > still)
            w->rested = -1;
        else if (w->rested < 0)
            w->rested = i;
        if (s->series)
            status = organ_write_frame(&w->scene, s->series);
        snprintf(words, sizeof words, "%.2f s, %d samples touch", w->moments[i].time, w->moments[i].touching);
        progress_show((double)(i + 1) / w->steps, words);
    }
    progress_end();
    if (!status && s->series)
        status = organ_write_series(&w->scene, s->series, dt);
    return status;
}

/* ---- what is written ------------------------------------------------------------------------------------------- */

static int write_table(work *w)
{
    char path[ORGAN_PATH + 32];
    sb_output out;
    snprintf(path, sizeof path, "%s.csv", w->set->out);
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return organ_complain_file(&w->scene, path);
    fprintf(out.file, "time_s,kinetic_J,floor_N,deepest_mm,touching,step_ms\n");
    for (int i = 0; i < w->steps; i++) {
        const moment *m = w->moments + i;
        fprintf(out.file, "%.6g,%.6g,%.6g,%.4g,%d,%.3g\n", m->time, m->kinetic, m->lift, 1e3 * m->deepest, m->touching,
                m->milliseconds);
    }
    return sb_output_close(&out, NULL) == SB_OK ? 0 : organ_complain_file(&w->scene, path);
}

/* Median time of a step (ms). */
static double typical_step(const work *w)
{
    double *times = (double *)malloc((size_t)w->steps * sizeof *times), middle = 0;
    for (int i = 0; times && i < w->steps; i++)
        times[i] = w->moments[i].milliseconds;
    if (times)
        middle = organ_median(times, w->steps);
    free(times);
    return middle;
}

static double deepest(const work *w)
{
    double most = 0;
    for (int i = 0; i < w->steps; i++)
        most = fmax(most, w->moments[i].deepest);
    return most;
}

static int draw_picture(work *w)
{
    const int width = 1280, height = 960;
    const moment *last = w->moments + w->steps - 1;
    char path[ORGAN_PATH + 32], title[128], details[200];
    double most = 0, high;
    picture p;
    if (sb_contact_pressures(w->scene.contact, w->scene.numbers) != SB_OK)
        return organ_complain(&w->scene, NULL, "pressures cannot be read", ORGAN_FAILED);
    for (int i = 0; i < w->scene.mesh.node_count; i++)
        most = fmax(most, (double)w->scene.numbers[i]);
    high = most > 0 ? picture_round_down(most) : 1;
    picture_begin(&p, width, height);
    organ_draw(&w->scene, &p, sb_body_positions(w->scene.body), w->scene.numbers, high);
    picture_render(&p, 30, 20);
    picture_colour_bar(&p, "contact pressure", "Pa", 0, high, most);
    picture_length_bar(&p);
    snprintf(title, sizeof title, "%d organs after %.2f s", w->set->count, last->time);
    snprintf(details, sizeof details, "%d nodes; a step of %.1f ms took %.1f ms", w->scene.mesh.node_count,
             1e3 / w->set->rate, typical_step(w));
    picture_text(&p, 0.06 * width, 0.075 * height, 22, PICTURE_LEFT, picture_ink(), title);
    picture_text(&p, 0.06 * width, 0.115 * height, 14, PICTURE_LEFT, picture_ink(), details);
    snprintf(path, sizeof path, "%s.png", w->set->out);
    return organ_save_picture(&w->scene, &p, path);
}

static int print_summary(work *w)
{
    const moment *last = w->moments + w->steps - 1;
    printf("organs      %d of %s: %d nodes, %d %s, E %.4g Pa, %.1f N in all\n", w->set->count,
           w->set->organ ? w->set->organ : "different shapes", w->scene.mesh.node_count, w->scene.mesh.element_count,
           sb_element_name(w->scene.mesh.element_type), w->set->young, w->weight);
    if (w->rested >= 0)
        printf("rest        from %.2f s on\n", w->moments[w->rested].time);
    else
        printf("rest        not within %.2f s: they still move\n", last->time);
    printf("overlap     %.2f mm at most, %.2f mm at the end\n", 1e3 * deepest(w), 1e3 * last->deepest);
    printf("written     %s.csv, %s.png\n", w->set->out, w->set->out);
    printf("rest=%d floor_over_weight=%.4f overlap_mm=%.3f step_ms=%.2f\n", w->rested >= 0, last->lift / w->weight,
           1e3 * last->deepest, typical_step(w));
    return 0;
}

static int run(const settings *set)
{
    static int (*const stages[])(work *) = {make_mesh, make_scene, fall, write_table, draw_picture, print_summary};
    work w;
    int status = 0;
    memset(&w, 0, sizeof w);
    w.set = set;
    for (size_t i = 0; i < sizeof stages / sizeof stages[0] && !status; i++)
        status = stages[i](&w);
    organ_free(&w.scene);
    free(w.moments);
    return status;
}

/* ---- command line ---------------------------------------------------------------------------------------------- */

static settings default_settings(void)
{
    settings s;
    memset(&s, 0, sizeof s);
    s.out = program_name;
    s.scale = 1;
    s.young = 5000;
    s.poisson = 0.4;
    s.friction = 0.2;
    s.seconds = 4;
    s.rate = 60;
    s.count = 4;
    s.cells = 6;
    s.seed = 1;
    return s;
}

enum { OPTION_COUNT = 15 };
static void list_options(settings *s, option options[OPTION_COUNT])
{
    const option all[OPTION_COUNT] = {
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &s->out, 0, 0, "files are NAME.csv and NAME.png"},
        {"--series", "NAME", OPTION_TEXT, NULL, NULL, &s->series, 0, 0, "also NAME_0000.vtk ... for ParaView"},
        {"--scale", "X", OPTION_NUMBER, NULL, &s->scale, NULL, 1e-9, 1e9,
         "multiplies the file's lengths; 0.001 for millimetres"},
        {"--count", "N", OPTION_INTEGER, &s->count, NULL, NULL, 1, MOST_ORGANS, "how many organs fall"},
        {"--cells", "N", OPTION_INTEGER, &s->cells, NULL, NULL, 2, 40, "along each side of an organ that is made"},
        {"--seed", "N", OPTION_INTEGER, &s->seed, NULL, NULL, 0, 1e6, "of shapes and turns"},
        {"--young", "PA", OPTION_NUMBER, NULL, &s->young, NULL, 1, 1e9, "Young's modulus (Pa)"},
        {"--poisson", "NU", OPTION_NUMBER, NULL, &s->poisson, NULL, 0, 0.49, "Poisson's ratio"},
        {"--friction", "MU", OPTION_NUMBER, NULL, &s->friction, NULL, 0, 10, "between organs, and on the floor"},
        {"--speed", "M/S", OPTION_NUMBER, NULL, &s->speed, NULL, 0, 10, "that they are thrown down with"},
        {"--seconds", "S", OPTION_NUMBER, NULL, &s->seconds, NULL, 0.1, 1000, "how long to look"},
        {"--rate", "HZ", OPTION_NUMBER, NULL, &s->rate, NULL, 10, 10000, "steps a second"},
        {"--self", NULL, OPTION_FLAG, &s->self, NULL, NULL, 0, 0, "organs touch themselves, too"},
        {"--help", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, "this text"},
        {"-h", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, NULL},
    };
    memcpy(options, all, sizeof all);
}

static int check_settings(const settings *s)
{
    if (!organ_check_name(program_name, "-o", s->out))
        return 0;
    if (!organ_check_name(program_name, "--series", s->series))
        return 0;
    return 1;
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
        printf("usage: drop [ORGAN] [OPTIONS]\n\n"
               "Organs fall on a floor and on each other, and come to rest. ORGAN: a volume mesh in metres (VTK, VTU,\n"
               "gmsh, Medit or TetGen), of which all are copies; without it round ones are made.\n\n");
        options_print(options, OPTION_COUNT);
        printf("\nThe last line: whether they came to rest (below %g m/s), what the floor carries over the weight of\n"
               "all, the deepest overlap at the end and the median time of a step.\n",
               still);
        return 0;
    }
    return check_settings(&s) ? run(&s) : ORGAN_USAGE;
}

int main(int argc, char **argv) { return finish(program_name, program(argc, argv), ORGAN_USAGE); }
