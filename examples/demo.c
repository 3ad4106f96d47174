/* demo: an organ lies under gravity, a ball on a rod presses into it, slides and lets go.
 *
 *     demo [ORGAN.vtk|ORGAN.msh|...] [OPTIONS]      demo --help lists the options
 *
 * Without a file the organ is made here. Part of it is held; the ball is a tool in contact, with friction. Written are
 * frames for ParaView, a picture coloured by stress, and how long a step took. Exit status: 0, 2 wrong usage or a file
 * that cannot be read or written, 3 a step failed. */
#include "system.h"

#if defined(_OPENMP)
#define SB_USE_OPENMP
#include <omp.h>
#endif
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "options.h"
#include "picture.h"

enum { EXIT_USAGE = 2, EXIT_SOLVE = 3, PATH_SIZE = 1024 };
#define REAL(x) ((sb_real)(x)) /* everything here computes in double, the body in sb_real */

/* ---- settings ----------------------------------------------------------------------------------- */

typedef struct settings {
    const char *organ;   /* file, or NULL: made here */
    const char *folder;  /* for all that is written */
    const char *picture; /* file, or NULL: demo.png in the folder */
    const char *material;
    double scale, dt, young, poisson, density;
    int frames, every, no_vtk, threads, help;
} settings;

static sb_material make_isochoric(sb_real young, sb_real poisson, sb_real density)
{
    sb_real mu = young / (2 * (1 + poisson)), bulk = young / (3 * (1 - 2 * poisson));
    return sb_material_neo_hookean_isochoric(mu / 2, 2 / bulk, density);
}

typedef struct material_name {
    const char *name;
    sb_material (*make)(sb_real young, sb_real poisson, sb_real density);
} material_name;

static const material_name materials[] = {
    {"corotated", sb_material_corotated},
    {"corotated_invertible", sb_material_corotated_invertible},
    {"linear", sb_material_linear},
    {"svk", sb_material_svk},
    {"neo_hookean", sb_material_neo_hookean},
    {"neo_hookean_isochoric", make_isochoric},
    {"stable_neo_hookean", sb_material_stable_neo_hookean},
};
enum { MATERIAL_COUNT = sizeof materials / sizeof *materials };

static const material_name *find_material(const char *name)
{
    for (int i = 0; i < MATERIAL_COUNT; i++)
        if (strcmp(name, materials[i].name) == 0)
            return &materials[i];
    return NULL;
}

enum { OPTION_COUNT = 14 };
static void list_options(settings *s, option options[OPTION_COUNT])
{
    const option all[OPTION_COUNT] = {
        {"-o", "DIR", OPTION_TEXT, NULL, NULL, &s->folder, 0, 0, "folder for what is written; made when missing"},
        {"--frames", "N", OPTION_INTEGER, &s->frames, NULL, NULL, 10, 1e6, "number of steps"},
        {"--dt", "S", OPTION_NUMBER, NULL, &s->dt, NULL, 1e-6, 1, "time of a step (s)"},
        {"--young", "PA", OPTION_NUMBER, NULL, &s->young, NULL, 1e-3, 1e12, "Young's modulus (Pa)"},
        {"--poisson", "NU", OPTION_NUMBER, NULL, &s->poisson, NULL, -0.99, 0.4999, "Poisson's ratio"},
        {"--density", "RHO", OPTION_NUMBER, NULL, &s->density, NULL, 1e-3, 1e6, "density (kg/m^3)"},
        {"--material", "NAME", OPTION_TEXT, NULL, NULL, &s->material, 0, 0, "see below"},
        {"--scale", "X", OPTION_NUMBER, NULL, &s->scale, NULL, 1e-9, 1e9,
         "multiplies the file's lengths; 0.001 for millimetres"},
        {"--every", "K", OPTION_INTEGER, &s->every, NULL, NULL, 0, 1e6, "write every K-th frame, 0 none"},
        {"--no-vtk", NULL, OPTION_FLAG, &s->no_vtk, NULL, NULL, 0, 0, "write no frames, as --every 0"},
        {"--picture", "FILE", OPTION_TEXT, NULL, NULL, &s->picture, 0, 0,
         "where the picture goes; default demo.png in the folder"},
        {"--threads", "N", OPTION_INTEGER, &s->threads, NULL, NULL, 1, 1024, "threads, when built with OpenMP"},
        {"--help", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, "this text"},
        {"-h", NULL, OPTION_FLAG, &s->help, NULL, NULL, 0, 0, NULL},
    };
    memcpy(options, all, sizeof all);
}

static void print_help(const settings *defaults)
{
    settings s = *defaults;
    option options[OPTION_COUNT];
    list_options(&s, options);
    printf("usage: demo [ORGAN] [OPTIONS]\n\n"
           "A ball presses into an organ that lies under gravity, slides and lets go. ORGAN: a volume mesh in\n"
           "metres (VTK, VTU, gmsh, Medit or TetGen); without it a liver-like one is made.\n\n");
    options_print(options, OPTION_COUNT);
    printf("\nmaterials:");
    for (int i = 0; i < MATERIAL_COUNT; i++)
        printf(" %s", materials[i].name);
    printf("\nexit status: 0 done, 2 wrong usage or a file that cannot be read or written, 3 a step failed\n"
           "or memory is short\n");
}

static int check_settings(const settings *s)
{
    if (!find_material(s->material))
        return options_complain("demo", s->material, "is no material");
#if !defined(_OPENMP)
    if (s->threads > 1)
        return options_complain("demo", "--threads", "needs a program built with OpenMP (-fopenmp)");
#endif
    return 1;
}

/* Reads the command line; 0 (with a message) when it is wrong. */
static int parse_arguments(settings *s, int count, char **arguments)
{
    option options[OPTION_COUNT];
    list_options(s, options);
    return options_parse("demo", options, OPTION_COUNT, &s->organ, 1, count, arguments) && check_settings(s);
}

/* demo_out beside the program: build/demo writes to build/demo_out. */
static void default_folder(const char *program, char path[PATH_SIZE])
{
    size_t length = strlen(program);
    while (length > 0 && program[length - 1] != '/' && program[length - 1] != '\\')
        length--;
    if (length > PATH_SIZE - 16)
        length = 0;
    memcpy(path, program, length);
    strcpy(path + length, "demo_out");
}

static settings default_settings(const char *folder)
{
    settings s;
    memset(&s, 0, sizeof s);
    s.folder = folder;
    s.material = "corotated";
    s.scale = 1;
    s.dt = 1.0 / 60;
    s.young = 8000; /* a liver, somewhat stiff */
    s.poisson = 0.45;
    s.density = 1060;
    s.frames = 300;
    s.every = 5;
    s.threads = 1;
    return s;
}

/* ---- the scene ---------------------------------------------------------------------------------- */

/* A ball that goes along `direction`, and then slides along `aside`. */
typedef struct tool {
    int number;                /* in the contact */
    double radius, gap, depth; /* m: of the ball; from the organ before; into it at most */
    sb_vec3 touch;             /* where it meets the organ */
    sb_vec3 direction, aside;  /* unit vectors, into it and along it */
    sb_vec3 centre;
    sb_vec3 force;     /* on the organ (N) */
    double peak_force; /* largest magnitude so far (N) */
} tool;

typedef struct scene {
    sb_mesh mesh;     /* as loaded: the undeformed shape */
    sb_boundary skin; /* its surface; skin.nodes are nodes of the mesh */
    sb_body *body;
    sb_contact *contact;
    sb_vec3 low, high; /* box of the undeformed shape */
    int fixed_count;
    sb_vec3 *shape;   /* [mesh.node_count] deformed nodes for files */
    sb_real *stress;  /* [mesh.node_count] von Mises stress (Pa) */
    sb_vec3 *normals; /* [skin nodes] */
    tool ball;
} scene;

static void free_scene(scene *s)
{
    sb_contact_destroy(s->contact);
    sb_body_destroy(s->body);
    sb_boundary_free(&s->skin);
    sb_mesh_free(&s->mesh);
    free(s->shape);
    free(s->stress);
    free(s->normals);
    memset(s, 0, sizeof *s);
}

/* Says what is wrong in one line. */
static int complain(const sb_error *error, int status)
{
    fprintf(stderr, "demo: ");
    if (error->file[0])
        fprintf(stderr, "%s:", error->file);
    if (error->line > 0)
        fprintf(stderr, "%d:", error->line);
    fprintf(stderr, "%s%s", error->file[0] ? " " : "", error->message);
    if (error->element >= 0 && !strstr(error->message, "element"))
        fprintf(stderr, ", element %d", error->element);
    if (error->node >= 0 && !strstr(error->message, "node"))
        fprintf(stderr, ", node %d", error->node);
    fprintf(stderr, " (%s)\n", sb_result_string(error->result));
    return status;
}

static int complain_path(const char *path)
{
    fprintf(stderr, "demo: %s is too long a path\n", path);
    return EXIT_USAGE;
}

static int complain_memory(void)
{
    fprintf(stderr, "demo: out of memory\n");
    return EXIT_SOLVE;
}

static sb_result get_organ(const settings *set, sb_mesh *mesh, sb_error *error)
{
    sb_load_options options = sb_default_load_options();
    sb_load_report report;
    sb_result result;
    options.scale = REAL(set->scale);
    options.report = &report;
    if (!set->organ)
        return sb_mesh_organ(SB_TET4, 16, NULL, mesh, error);
    result = sb_mesh_load(mesh, set->organ, &options, error);
    for (int i = 0; !result && i < report.note_count; i++)
        fprintf(stderr, "demo: %s: note: %s\n", set->organ, report.notes[i]);
    return result;
}

/* Loads or makes the mesh, its surface and the arrays that go with them. */
static int make_mesh(const settings *set, scene *s)
{
    sb_error error;
    size_t nodes, skin_nodes;
    if (get_organ(set, &s->mesh, &error) != SB_OK)
        return complain(&error, EXIT_USAGE);
    if (sb_element_dimension(s->mesh.element_type) != 3) {
        fprintf(stderr, "demo: %s is a surface (%s); a body needs a volume mesh: surface_to_sim fills it with tets\n",
                set->organ, sb_element_name(s->mesh.element_type));
        return EXIT_USAGE;
    }
    /* neighbours in memory: fewer cache misses; errors and files then count in the new order */
    if (sb_mesh_reorder(&s->mesh, NULL, NULL, &error) != SB_OK ||
        sb_mesh_boundary(&s->mesh, 1, NULL, &s->skin, &error) != SB_OK)
        return complain(&error, EXIT_USAGE);
    sb_mesh_bounds(&s->mesh, &s->low, &s->high);
    nodes = (size_t)s->mesh.node_count, skin_nodes = (size_t)s->skin.surface.node_count;
    s->shape = (sb_vec3 *)calloc(nodes, sizeof *s->shape);
    s->stress = (sb_real *)calloc(nodes, sizeof *s->stress);
    s->normals = (sb_vec3 *)calloc(skin_nodes, sizeof *s->normals);
    return s->shape && s->stress && s->normals ? 0 : complain_memory();
}

static int compare_reals(const void *a, const void *b)
{
    sb_real x = *(const sb_real *)a, y = *(const sb_real *)b;
    return (x > y) - (x < y);
}

/* How far back (+y) and down (-z) a node of the undeformed shape lies, from 0 to 1. */
static sb_real place_in_box(const scene *s, sb_vec3 x)
{
    sb_real back = (x.y - s->low.y) / (s->high.y - s->low.y);
    sb_real down = (s->high.z - x.z) / (s->high.z - s->low.z);
    return REAL(0.6) * back + REAL(0.4) * down;
}

/* Holds the rear lower third of the organ, as if it lay there and had grown on. */
static sb_result hold_organ(scene *s)
{
    sb_real *places = s->stress, limit; /* borrowed */
    for (int i = 0; i < s->mesh.node_count; i++)
        places[i] = place_in_box(s, s->mesh.nodes[i]);
    qsort(places, (size_t)s->mesh.node_count, sizeof *places, compare_reals);
    limit = places[(size_t)s->mesh.node_count * 2 / 3];
    for (int i = 0; i < s->mesh.node_count; i++)
        if (place_in_box(s, s->mesh.nodes[i]) >= limit) {
            sb_result result = sb_body_fix_nodes(s->body, &i, 1, SB_XYZ);
            if (result != SB_OK)
                return result;
            s->fixed_count++;
        }
    return SB_OK;
}

static void print_warnings(const scene *s)
{
    sb_check_report report;
    if (sb_body_check(s->body, &report) != SB_OK)
        return;
    for (unsigned bit = 1; bit && bit <= report.warnings; bit <<= 1)
        if (report.warnings & bit)
            fprintf(stderr, "demo: warning: %s\n", sb_check_string(bit));
    if (report.warnings & SB_CHECK_SIZE)
        fprintf(stderr, "demo: warning: the organ measures %.3g m; is it in millimetres? then add --scale 0.001\n",
                (double)report.size);
}

static int make_body(const settings *set, scene *s)
{
    sb_error error;
    sb_body_def def = sb_default_body_def();
    sb_contact_def contact = sb_default_contact_def();
    def.mesh = &s->mesh;
    def.material = find_material(set->material)->make(REAL(set->young), REAL(set->poisson), REAL(set->density));
    def.single_rotation = s->mesh.element_type == SB_TET10 && def.material.model == SB_COROTATED; /* faster */
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.damping_stiffness = REAL(0.02); /* tissue rings for a few tenths of a second, not longer */
    def.tolerance = REAL(1e-2);         /* below what an eye sees, and half the time of 1e-3 */
#if defined(_OPENMP)
    omp_set_num_threads(set->threads);
    if (set->threads > 1)
        def.jobs = sb_jobs_openmp();
#endif
    if (sb_body_create(&def, &s->body, &error) != SB_OK)
        return complain(&error, EXIT_USAGE);
    if (hold_organ(s) != SB_OK)
        return complain_memory();
    contact.body = s->body;
    if (sb_contact_create(&contact, &s->contact, &error) != SB_OK)
        return complain(&error, EXIT_USAGE);
    print_warnings(s);
    return 0;
}

/* ---- the ball ----------------------------------------------------------------------------------- */

static sb_vec3 unit(sb_vec3 v)
{
    sb_real length = sb_v3_norm(v);
    return length > 0 ? sb_v3_scale(1 / length, v) : sb_v3(0, 0, 1);
}

/* Area-weighted normals of the deformed skin (not of unit length). */
static void update_normals(scene *s)
{
    const sb_mesh *surface = &s->skin.surface;
    const sb_vec3 *x = sb_body_positions(s->body);
    int nodes = sb_element_node_count(surface->element_type);
    memset(s->normals, 0, (size_t)surface->node_count * sizeof *s->normals);
    for (int i = 0; i < surface->element_count; i++) {
        const int *face = surface->elements + (size_t)i * (size_t)nodes;
        sb_vec3 a = x[s->skin.nodes[face[0]]], b = x[s->skin.nodes[face[1]]], c = x[s->skin.nodes[face[2]]];
        sb_vec3 normal = sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(c, a));
        for (int k = 0; k < nodes; k++)
            s->normals[face[k]] = sb_v3_add(s->normals[face[k]], normal);
    }
}

/* Puts the ball above the upper side of the organ as it lies now, in front of where it is held. */
static int aim_ball(scene *s)
{
    const double friction = 0.3;
    sb_tool_def def = sb_default_tool_def();
    sb_error error;
    const sb_vec3 *x = sb_body_positions(s->body);
    sb_vec3 size = sb_v3_sub(s->high, s->low), normal = sb_v3(0, 0, 1);
    double spot_x = (double)s->low.x + 0.40 * (double)size.x;
    double spot_y = (double)s->low.y + 0.37 * (double)size.y;
    double diagonal = (double)sb_v3_norm(size), best = 1e300;
    update_normals(s);
    s->ball.touch = s->high;
    for (int i = 0; i < s->skin.surface.node_count; i++) {
        int node = s->skin.nodes[i];
        double away = hypot((double)x[node].x - spot_x, (double)x[node].y - spot_y);
        sb_vec3 n = unit(s->normals[i]);
        if (n.z < REAL(0.3) || sb_body_supports(s->body)[node] || away >= best)
            continue;
        best = away;
        s->ball.touch = x[node];
        normal = n;
    }
    s->ball.direction = unit(sb_v3_sub(sb_v3(0, 0, -1), normal));
    s->ball.aside = unit(sb_v3_cross(s->ball.direction, sb_v3(0, 1, 0)));
    s->ball.radius = 0.075 * diagonal;
    s->ball.gap = 0.2 * s->ball.radius;
    s->ball.depth = 0.065 * diagonal;
    def.radius = REAL(s->ball.radius);
    def.friction = REAL(friction);
    def.pose.position = s->ball.centre =
        sb_v3_madd(s->ball.touch, REAL(-s->ball.gap - s->ball.radius), s->ball.direction);
    if (sb_contact_add_tool(s->contact, &def, &s->ball.number, &error) != SB_OK)
        return complain(&error, EXIT_SOLVE);
    return 0;
}

/* 0 to 1 with velocity and acceleration 0 at both ends. */
static double smooth_step(double t)
{
    t = t < 0 ? 0 : (t > 1 ? 1 : t);
    return t * t * t * (10 + t * (6 * t - 15));
}

/* The story, as shares of its length: settle, press, slide, go back, settle. */
static const double press_begins = 0.24, press_ends = 0.54, return_begins = 0.72, return_ends = 0.92;

/* How far the ball has moved along its direction at a moment from 0 to 1; its surface then is at -gap +
 * travel. */
static double ball_travel(const tool *ball, double moment)
{
    double in = smooth_step((moment - press_begins) / (press_ends - press_begins));
    double out = smooth_step((moment - return_begins) / (return_ends - return_begins));
    return (in - out) * (ball->gap + ball->depth);
}

/* Where the ball is to be at a moment from 0 to 1. */
static sb_result move_ball(scene *s, double moment)
{
    double travel = ball_travel(&s->ball, moment) - s->ball.gap - s->ball.radius;
    double slide = 0.7 * s->ball.radius * smooth_step((moment - press_ends) / (return_begins - press_ends));
    sb_pose pose;
    s->ball.centre = sb_v3_madd(s->ball.touch, REAL(travel), s->ball.direction);
    s->ball.centre = sb_v3_madd(s->ball.centre, REAL(slide), s->ball.aside);
    pose.position = s->ball.centre;
    pose.rotation = sb_quat_identity();
    return sb_contact_move_tool(s->contact, s->ball.number, &pose);
}

/* What the ball exerts on the organ. */
static void read_force(scene *s)
{
    sb_wrench wrench;
    if (sb_contact_wrench(s->contact, s->ball.number, &wrench) != SB_OK)
        return; /* it is not there yet */
    s->ball.force = sb_v3_scale(-1, wrench.force);
    s->ball.peak_force = fmax(s->ball.peak_force, (double)sb_v3_norm(s->ball.force));
}

/* ---- what is written ---------------------------------------------------------------------------- */

/* FOLDER/NAME; 0 when it is too long. */
static int join_path(char path[PATH_SIZE], const char *folder, const char *name)
{
    size_t length = strlen(folder);
    const char *slash = length && folder[length - 1] == '/' ? "" : "/";
    int written = snprintf(path, PATH_SIZE, "%s%s%s", folder, slash, name);
    return written > 0 && written < PATH_SIZE;
}

/* One file of the series: the deformed organ with displacement, velocity and von Mises stress. */
static int write_frame(scene *s, const char *folder, int index)
{
    char name[32], path[PATH_SIZE];
    sb_error error;
    sb_mesh deformed = s->mesh;
    const sb_field fields[3] = {
        {"displacement", SB_FIELD_NODES, 3, &sb_body_displacements(s->body)[0].x},
        {"velocity", SB_FIELD_NODES, 3, &sb_body_velocities(s->body)[0].x},
        {"von_mises", SB_FIELD_NODES, 1, s->stress},
    };
    memcpy(s->shape, sb_body_positions(s->body), (size_t)s->mesh.node_count * sizeof *s->shape);
    deformed.nodes = s->shape;
    sb_body_nodal_von_mises(s->body, s->stress);
    snprintf(name, sizeof name, "demo_%04d.vtk", index);
    if (!join_path(path, folder, name))
        return complain_path(folder);
    if (sb_mesh_save_vtk_binary(path, &deformed, fields, 3, &error) != SB_OK)
        return complain(&error, EXIT_USAGE);
    return 0;
}

/* ParaView's list of the files with their times. */
static int write_series(const char *folder, int count, double interval)
{
    char path[PATH_SIZE];
    sb_output out;
    int good = join_path(path, folder, "demo.vtk.series") && sb_output_open(&out, path, NULL) == SB_OK;
    if (good) {
        fprintf(out.file, "{\"file-series-version\": \"1.0\", \"files\": [\n");
        for (int i = 0; i < count; i++)
            fprintf(out.file, "  {\"name\": \"demo_%04d.vtk\", \"time\": %.6g}%s\n", i, i * interval,
                    i + 1 < count ? "," : "");
        fprintf(out.file, "]}\n");
        good = sb_output_close(&out, NULL) == SB_OK;
    }
    if (!good)
        fprintf(stderr, "demo: %s cannot be written\n", path);
    return good ? 0 : EXIT_USAGE;
}

/* Upper end of the colour map: 98 % of the skin lie below, rounded up to two digits that divide well. */
static double colour_limit(sb_real *sorted, int count)
{
    static const double nice[] = {1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10};
    double limit, power;
    int i = 0;
    qsort(sorted, (size_t)count, sizeof *sorted, compare_reals);
    limit = (double)sorted[(size_t)count * 98 / 100];
    if (!(limit > 0))
        return 1;
    power = pow(10, floor(log10(limit)));
    while (nice[i] * power < limit)
        i++;
    return nice[i] * power;
}

static void describe(const settings *set, const scene *s, char title[128], char details[256])
{
    const char *name = set->organ ? set->organ : "Liver-like organ";
    for (const char *c = name; *c; c++)
        if ((*c == '/' || *c == '\\') && c[1])
            name = c + 1;
    snprintf(title, 128, "%.60s under gravity and a %.0f mm ball", name, 2e3 * s->ball.radius);
    snprintf(details, 256, "%d %s, %s, E %.4g kPa, nu %.3g; ball %.1f mm deep, %.2f N", s->mesh.element_count,
             sb_element_name(s->mesh.element_type), set->material, 1e-3 * set->young, set->poisson, 1e3 * s->ball.depth,
             (double)sb_v3_norm(s->ball.force));
}

static void draw_ball(picture *p, const tool *ball)
{
    picture_colour steel = picture_web(0x9aa5b1);
    sb_vec3 end = sb_v3_madd(ball->centre, REAL(-3.2 * ball->radius), ball->direction);
    picture_add_capsule(p, ball->centre, ball->centre, 0.985 * ball->radius, steel);
    picture_add_capsule(p, ball->centre, end, 0.22 * ball->radius, steel);
}

static int draw_picture(const settings *set, scene *s, const char *path)
{
    const int width = 1280, height = 960;
    sb_mesh surface = s->skin.surface;
    char title[128], details[256];
    int count = surface.node_count, result;
    sb_real *values = (sb_real *)malloc((size_t)count * sizeof *values);
    sb_real *sorted = (sb_real *)malloc((size_t)count * sizeof *sorted);
    picture p;
    picture_begin(&p, width, height);
    if (values && sorted) {
        double limit, unit_value;
        sb_body_nodal_von_mises(s->body, s->stress);
        surface.nodes = s->shape;
        for (int i = 0; i < count; i++) {
            s->shape[i] = sb_body_positions(s->body)[s->skin.nodes[i]];
            values[i] = sorted[i] = s->stress[s->skin.nodes[i]];
        }
        limit = colour_limit(sorted, count);
        unit_value = limit >= 1000 ? 1000 : 1;
        describe(set, s, title, details);
        picture_add_surface(&p, &surface, values, 0, limit);
        draw_ball(&p, &s->ball);
        picture_render(&p, 22, 30);
        picture_colour_bar(&p, "von Mises stress", limit >= 1000 ? "kPa" : "Pa", 0, limit / unit_value,
                           (double)sorted[count - 1] / unit_value);
        picture_length_bar(&p);
        picture_text(&p, 0.06 * width, 0.075 * height, 22, PICTURE_LEFT, picture_ink(), title);
        picture_text(&p, 0.06 * width, 0.115 * height, 14, PICTURE_LEFT, picture_ink(), details);
    }
    result = values && sorted ? picture_save_png(&p, path) : PICTURE_NO_MEMORY;
    picture_end(&p);
    free(values);
    free(sorted);
    if (result == PICTURE_NO_FILE)
        fprintf(stderr, "demo: %s cannot be written\n", path);
    return result == PICTURE_OK ? 0 : (result == PICTURE_NO_FILE ? EXIT_USAGE : complain_memory());
}

/* ---- the run ------------------------------------------------------------------------------------ */

/* A bar in a terminal, a line now and then elsewhere. */
static void show_progress(int frame, int frames, double seconds)
{
    char words[64];
    snprintf(words, sizeof words, "frame %d of %d, %6.2f ms", frame + 1, frames, 1e3 * seconds);
    progress_show((frame + 1.0) / frames, words);
    if (is_terminal() ? frame + 1 == frames : (frame + 1) * 10 / frames > frame * 10 / frames)
        fprintf(stderr, "%s\n", is_terminal() ? "" : words);
}

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Median, 95th percentile and worst of the time per frame: ball and step, no files. */
static void print_times(double *seconds, int count, double dt, long iterations)
{
    qsort(seconds, (size_t)count, sizeof *seconds, compare_doubles);
    double median = seconds[count / 2], late = seconds[count * 95 / 100], worst = seconds[count - 1];
    printf("simulation   median %.2f ms, 95%% within %.2f ms, worst %.2f ms: %.0f Hz (%.1f x real time),\n"
           "             %.1f PCG iterations per step\n",
           1e3 * median, 1e3 * late, 1e3 * worst, 1 / median, dt / median, (double)iterations / count);
}

/* One frame: the ball moves, the body follows. Returns 0 or an exit status. */
static int run_frame(const settings *set, scene *s, int frame, double *seconds, long *iterations)
{
    sb_step_info info;
    double start = seconds_now(), moment = (frame + 1.0) / set->frames;
    if (frame == (int)(press_begins * set->frames) && aim_ball(s))
        return EXIT_SOLVE;
    if (frame >= (int)(press_begins * set->frames) && move_ball(s, moment) != SB_OK)
        return complain_memory();
    if (sb_body_step(s->body, REAL(set->dt), &info) != SB_OK) {
        fprintf(stderr, "%sdemo: frame %d: the step failed\n", is_terminal() ? "\n" : "", frame);
        return complain(&info.error, EXIT_SOLVE);
    }
    read_force(s);
    *seconds = seconds_now() - start;
    *iterations += info.pcg_iterations;
    return 0;
}

typedef struct outputs {
    char picture[PATH_SIZE];
    int files; /* of the series */
} outputs;

static int run(const settings *set, scene *s, double *seconds, long *iterations, outputs *out)
{
    int picture_frame = (int)(return_begins * set->frames) - 1;
    int every = set->no_vtk ? 0 : set->every, status = every ? write_frame(s, set->folder, out->files++) : 0;
    for (int frame = 0; frame < set->frames && !status; frame++) {
        status = run_frame(set, s, frame, &seconds[frame], iterations);
        if (!status && every && (frame + 1) % every == 0)
            status = write_frame(s, set->folder, out->files++);
        if (!status && frame == picture_frame)
            status = draw_picture(set, s, out->picture);
        if (!status)
            show_progress(frame, set->frames, seconds[frame]);
    }
    if (!status && every)
        status = write_series(set->folder, out->files, every * set->dt);
    return status;
}

static void print_scene(const settings *set, const scene *s)
{
    sb_vec3 size = sb_v3_sub(s->high, s->low);
    printf("organ        %s: %d nodes, %d %s, %.0f x %.0f x %.0f mm, %.3g kg\n", set->organ ? set->organ : "made here",
           s->mesh.node_count, s->mesh.element_count, sb_element_name(s->mesh.element_type), 1e3 * (double)size.x,
           1e3 * (double)size.y, 1e3 * (double)size.z, (double)sb_body_mass(s->body));
    printf("material     %s, E %.4g Pa, nu %.4g, density %.4g kg/m^3; %d nodes held\n", set->material, set->young,
           set->poisson, set->density, s->fixed_count);
}

static void print_summary(const settings *set, const scene *s, const outputs *out)
{
    double way = s->ball.gap + s->ball.depth, time = (press_ends - press_begins) * set->frames * set->dt;
    printf("ball         radius %.1f mm, %.1f mm deep at up to %.1f cm/s, peak force %.2f N\n", 1e3 * s->ball.radius,
           1e3 * s->ball.depth, 100 * 1.875 * way / time, s->ball.peak_force);
    if (out->files)
        printf("frames       %s/demo_0000.vtk to demo_%04d.vtk; ParaView opens %s/demo.vtk.series\n", set->folder,
               out->files - 1, set->folder);
    printf("picture      %s\n", out->picture);
}

/* Path of the picture; 0 when it is too long. */
static int name_picture(const settings *set, char path[PATH_SIZE])
{
    if (!set->picture)
        return join_path(path, set->folder, "demo.png");
    return snprintf(path, PATH_SIZE, "%s", set->picture) < PATH_SIZE;
}

static int demo(const settings *set)
{
    outputs out;
    scene s;
    long iterations = 0;
    double *seconds = (double *)calloc((size_t)set->frames, sizeof *seconds);
    int status = seconds ? 0 : complain_memory();
    memset(&s, 0, sizeof s);
    memset(&out, 0, sizeof out);
    if (!status && !name_picture(set, out.picture))
        status = complain_path(set->picture ? set->picture : set->folder);
    if (!status)
        status = make_mesh(set, &s);
    if (!status)
        status = make_body(set, &s);
    if (!status && !make_folder(set->folder)) {
        fprintf(stderr, "demo: folder %s cannot be made: %s\n", set->folder, strerror(errno));
        status = EXIT_USAGE;
    }
    if (!status) {
        print_scene(set, &s);
        status = run(set, &s, seconds, &iterations, &out);
    }
    if (!status) {
        print_times(seconds, set->frames, set->dt, iterations);
        print_summary(set, &s, &out);
    }
    free_scene(&s);
    free(seconds);
    return status;
}

static int program(int argc, char **argv)
{
    char folder[PATH_SIZE];
    default_folder(argc > 0 ? argv[0] : "", folder);
    settings set = default_settings(folder), defaults = set;
    if (!parse_arguments(&set, argc, argv))
        return EXIT_USAGE;
    if (set.help) {
        print_help(&defaults);
        return 0;
    }
    return demo(&set);
}

int main(int argc, char **argv) { return finish("demo", program(argc, argv), EXIT_USAGE); }
