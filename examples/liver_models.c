/* liver_models: does it matter which material a liver is given, when its surface's motion is known?
 *
 *     liver_models [LIVER.vtk|LIVER.msh|...] [OPTIONS]      liver_models --help lists the options
 *
 * Repeats the study of section 4.3 of Suwelack, Real-time biomechanical modeling for intraoperative soft tissue
 * registration (2014): a liver is deformed as by breathing and as by an instrument, once with each material of the
 * literature; printed is how far each lands from the reference (Raghunathan et al. 2010), beside the thesis' table
 * 4.4. Exit status: 0, 2 wrong usage or a file that cannot be read or written, 3 a step failed or memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "options.h"

#include <time.h>

enum { EXIT_USAGE = 2, EXIT_SOLVE = 3, PATTERNS = 2 };

typedef struct settings {
    const char *liver;   /* file, or NULL: made here */
    const char *folder;  /* for VTK files, or NULL: none are written */
    double scale;        /* of the file's lengths */
    double breath, dent; /* greatest prescribed displacements (m) */
    double duration;     /* s */
    int steps, cells, help;
} settings;

/* ---- materials: tables 4.1 to 4.4 ------------------------------------------------------------------------------ */

typedef struct model {
    const char *name;
    sb_preset preset;
    int corotated;                /* 1: the linear model's constants in the corotated formulation */
    double beta;                  /* Rayleigh damping (s) */
    const char *thesis[PATTERNS]; /* maximum / mean distance to the reference (mm) */
} model;

static const model models[] = {
    {"Raghunathan 2010 (reference)", SB_LIVER_RAGHUNATHAN, 0, 0, {"", ""}},
    {"Jordan 2009", SB_LIVER_JORDAN, 0, 0, {"0.58 / 0.16", "1.14 / 0.22"}},
    {"Kim 2005", SB_LIVER_KIM, 0, 0, {"0.55 / 0.13", "1.11 / 0.18"}},
    {"simplified neo-Hookean", SB_LIVER_NEO_HOOKEAN, 0, 0.21, {"0.25 / 0.07", "0.27 / 0.007"}},
    {"corotated linear", SB_LIVER_LINEAR, 1, 0.21, {"0.47 / 0.13", "0.55 / 0.09"}}, /* tables 5.1, 5.2 */
    {"linear", SB_LIVER_LINEAR, 0, 0.21, {"3.88 / 1.28", "0.66 / 0.007"}},
};
enum { MODELS = sizeof models / sizeof models[0] };

static const sb_real density = 1060; /* kg/m^3 */

static sb_material make_material(const model *m)
{
    sb_material material = sb_material_preset(m->preset, density);
    if (m->corotated)
        material = sb_material_corotated(sb_material_young(&material), sb_material_poisson(&material), density);
    return material;
}

/* ---- deformation patterns (figure 4.5) ------------------------------------------------------------------------- */

static const char *const pattern_names[PATTERNS] = {"respiration", "instrument"};

/* Supported nodes of a pattern and where they end. */
typedef struct pattern {
    int fixed_count, moved_count;
    int *fixed, *moved;  /* [mesh.node_count] each */
    sb_vec3 *ends, *way; /* [mesh.node_count] displacement (m) of moved nodes: at last, now */
} pattern;

typedef struct study {
    const settings *set;
    sb_mesh mesh;
    sb_boundary skin;
    sb_vec3 *normals; /* [skin.surface.node_count] outward */
    sb_vec3 low, high;
    pattern patterns[PATTERNS];
    sb_vec3 *results[PATTERNS][MODELS]; /* [mesh.node_count] displacement (m) in the end */
} study;

/* 0 below low, 1 above high, smooth between. */
static double smooth_step(double x, double low, double high)
{
    double t = x <= low ? 0 : x >= high ? 1 : (x - low) / (high - low);
    return t * t * (3 - 2 * t);
}

/* Outward normals of the skin's nodes from the corners of its faces. */
static void make_normals(study *s)
{
    const sb_mesh *skin = &s->skin.surface;
    int n = sb_element_node_count(skin->element_type), corners = sb_element_corner_count(skin->element_type);
    for (int f = 0; f < skin->element_count; f++) {
        const int *face = skin->elements + (size_t)f * (size_t)n;
        sb_vec3 a = skin->nodes[face[0]], b = skin->nodes[face[1]], c = skin->nodes[face[corners - 1]];
        sb_vec3 normal = sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(c, a));
        for (int k = 0; k < n; k++)
            s->normals[face[k]] = sb_v3_add(s->normals[face[k]], normal);
    }
    for (int i = 0; i < skin->node_count; i++)
        s->normals[i] = sb_v3_scale(1 / sb_v3_norm(s->normals[i]), s->normals[i]);
}

static void hold(pattern *p, int node) { p->fixed[p->fixed_count++] = node; }

static void move(pattern *p, int node, sb_vec3 end)
{
    p->moved[p->moved_count] = node;
    p->ends[p->moved_count++] = end;
}

/* The hinge (x, z) about which breathing turns the right lobe, in shares of the liver's width and height, and the
 * share of its width right of it from which on the dome moves. */
static const double hinge_across = 0.6, hinge_up = 0.5, hinge_gap = 0.2;

static int is_dome(const study *s, int skin_node)
{
    double up = (double)((s->skin.surface.nodes[skin_node].z - s->low.z) / (s->high.z - s->low.z));
    return up > 0.4 && (double)s->normals[skin_node].z > 0.5;
}

/* Breathing: the lower left side is held, the right dome turns down with the diaphragm, about an axis from front to
 * back. It is this turn that tells linear models from others. */
static void make_respiration(study *s)
{
    const sb_mesh *skin = &s->skin.surface;
    sb_vec3 size = sb_v3_sub(s->high, s->low), hinge;
    double reach = 0, angle;
    hinge = sb_v3(s->low.x + (sb_real)hinge_across * size.x, 0, s->low.z + (sb_real)hinge_up * size.z);
    for (int pass = 0; pass < 2; pass++) { /* first the farthest node, then what moves */
        angle = reach > 0 ? 2 * asin(fmin(1, s->set->breath / (2 * reach))) : 0;
        for (int i = 0; i < skin->node_count; i++) {
            double x = (double)(skin->nodes[i].x - hinge.x), z = (double)(skin->nodes[i].z - hinge.z);
            if (x > 0 && z < 0 && pass == 1)
                hold(s->patterns, s->skin.nodes[i]);
            if (x > -hinge_gap * (double)size.x || !is_dome(s, i))
                continue;
            reach = fmax(reach, hypot(x, z));
            if (pass == 1)
                move(s->patterns, s->skin.nodes[i],
                     sb_v3((sb_real)(cos(angle) * x - sin(angle) * z - x), 0,
                           (sb_real)(sin(angle) * x + cos(angle) * z - z)));
        }
    }
}

/* An instrument: a dent in the middle of the lower side, the dome held. */
static void make_dent(study *s)
{
    pattern *p = s->patterns + 1;
    const sb_mesh *skin = &s->skin.surface;
    double radius = 0.1 * (double)(s->high.x - s->low.x);
    sb_vec3 centre = sb_v3_scale((sb_real)0.5, sb_v3_add(s->low, s->high)), inwards;
    int touched = 0;
    for (int i = 0; i < skin->node_count; i++) { /* the lowest node below the middle */
        sb_vec3 d = sb_v3_sub(skin->nodes[i], centre);
        if ((double)(d.x * d.x + d.y * d.y) < radius * radius && skin->nodes[i].z < skin->nodes[touched].z)
            touched = i;
    }
    inwards = sb_v3_scale(-1, s->normals[touched]);
    for (int i = 0; i < skin->node_count; i++) {
        double distance = (double)sb_v3_norm(sb_v3_sub(skin->nodes[i], skin->nodes[touched]));
        if (is_dome(s, i))
            hold(p, s->skin.nodes[i]);
        else if (distance < radius)
            move(p, s->skin.nodes[i],
                 sb_v3_scale((sb_real)(s->set->dent * (1 - smooth_step(distance, 0, radius))), inwards));
    }
}

/* ---- messages and memory --------------------------------------------------------------------------------------- */

static int complain(const char *what, const sb_error *error, int status)
{
    int has_file = error->file[0] && strcmp(error->file, what) != 0;
    fprintf(stderr, "liver_models: %s%s%s", what, has_file ? ": " : "", has_file ? error->file : "");
    if (error->line > 0)
        fprintf(stderr, ":%d", error->line);
    fprintf(stderr, ": %s\n", error->message);
    return status;
}

static int complain_memory(void)
{
    fprintf(stderr, "liver_models: out of memory\n");
    return EXIT_SOLVE;
}

static void release(study *s)
{
    for (int p = 0; p < PATTERNS; p++) {
        free(s->patterns[p].fixed);
        free(s->patterns[p].moved);
        free(s->patterns[p].ends);
        free(s->patterns[p].way);
        for (int m = 0; m < MODELS; m++)
            free(s->results[p][m]);
    }
    free(s->normals);
    sb_boundary_free(&s->skin);
    sb_mesh_free(&s->mesh);
}

/* ---- preparing ------------------------------------------------------------------------------------------------- */

/* The liver as tet10, whatever it came as. */
static int make_mesh(study *s)
{
    sb_error error;
    sb_load_options options = sb_default_load_options();
    sb_mesh quadratic;
    options.scale = (sb_real)s->set->scale;
    sb_result result = s->set->liver ? sb_mesh_load(&s->mesh, s->set->liver, &options, &error)
                                     : sb_mesh_organ(SB_TET10, s->set->cells, NULL, &s->mesh, &error);
    if (result != SB_OK)
        return complain(s->set->liver ? s->set->liver : "making a liver", &error, EXIT_USAGE);
    if (s->mesh.element_type == SB_TET4) {
        result = sb_mesh_to_tet10(&s->mesh, NULL, &quadratic, &error);
        if (result != SB_OK)
            return complain(s->set->liver, &error, EXIT_SOLVE);
        sb_mesh_free(&s->mesh);
        s->mesh = quadratic;
    }
    if (sb_element_dimension(s->mesh.element_type) != 3) {
        fprintf(stderr, "liver_models: %s is a surface; a volume mesh is needed\n", s->set->liver);
        return EXIT_USAGE;
    }
    sb_mesh_reorder(&s->mesh, NULL, NULL, NULL); /* only makes it faster */
    if (sb_mesh_boundary(&s->mesh, 1, NULL, &s->skin, &error) != SB_OK)
        return complain("the surface", &error, EXIT_SOLVE);
    sb_mesh_bounds(&s->mesh, &s->low, &s->high);
    return 0;
}

static int make_patterns(study *s)
{
    size_t n = (size_t)s->mesh.node_count;
    int complete = 1;
    s->normals = (sb_vec3 *)calloc((size_t)s->skin.surface.node_count, sizeof(sb_vec3));
    for (int k = 0; k < PATTERNS; k++) {
        pattern *p = s->patterns + k;
        p->fixed = (int *)calloc(n, sizeof(int));
        p->moved = (int *)calloc(n, sizeof(int));
        p->ends = (sb_vec3 *)calloc(n, sizeof(sb_vec3));
        p->way = (sb_vec3 *)calloc(n, sizeof(sb_vec3));
        complete = complete && p->fixed && p->moved && p->ends && p->way;
        for (int m = 0; m < MODELS; m++) {
            s->results[k][m] = (sb_vec3 *)calloc(n, sizeof(sb_vec3));
            complete = complete && s->results[k][m];
        }
    }
    if (!complete || !s->normals)
        return complain_memory();
    make_normals(s);
    make_respiration(s);
    make_dent(s);
    for (int k = 0; k < PATTERNS; k++)
        if (s->patterns[k].fixed_count < 3 || s->patterns[k].moved_count < 1) {
            fprintf(stderr, "liver_models: the %s pattern finds no place on this shape (z must point to the head)\n",
                    pattern_names[k]);
            return EXIT_USAGE;
        }
    return 0;
}

/* ---- solving --------------------------------------------------------------------------------------------------- */

static int make_body(study *s, const model *m, sb_body **body)
{
    sb_body_def def = sb_default_body_def();
    sb_error error;
    def.mesh = &s->mesh;
    def.material = make_material(m);
    def.damping_stiffness = (sb_real)m->beta;
    def.max_newton = 30;
    def.newton_tolerance = (sb_real)1e-5;
    def.max_iterations = 5000;
    if (sb_body_create(&def, body, &error) != SB_OK)
        return complain(m->name, &error, EXIT_SOLVE);
    return 0;
}

/* Puts the supports at a share of their way and steps there. */
static sb_result move_on(sb_body *body, pattern *p, double share, double dt, sb_step_info *info)
{
    for (int i = 0; i < p->moved_count; i++)
        p->way[i] = sb_v3_scale((sb_real)share, p->ends[i]);
    if (sb_body_prescribe(body, p->moved, p->moved_count, SB_XYZ, p->way, 0) != SB_OK)
        return SB_ERROR_MEMORY;
    return sb_body_step(body, (sb_real)dt, info);
}

/* Deforms the liver over the duration, starting and stopping softly, and keeps its last displacement. */
static int solve(study *s, int pattern_index, int model_index)
{
    const double pi = 3.14159265358979323846;
    const settings *set = s->set;
    const model *m = models + model_index;
    pattern *p = s->patterns + pattern_index;
    sb_body *body = NULL;
    int status = make_body(s, m, &body), iterations = 0;
    clock_t begin = clock();
    if (!status && sb_body_fix_nodes(body, p->fixed, p->fixed_count, SB_XYZ) != SB_OK)
        status = complain_memory();
    for (int step = 1; step <= set->steps && !status; step++) {
        sb_step_info info;
        double share = 0.5 - 0.5 * cos(pi * step / set->steps);
        if (move_on(body, p, share, set->duration / set->steps, &info) != SB_OK) {
            fprintf(stderr, "\nliver_models: %s, %s, step %d: %s\n", pattern_names[pattern_index], m->name, step,
                    info.error.message);
            status = EXIT_SOLVE;
        }
        iterations += info.newton_iterations;
        fprintf(stderr, "\r%-12s %-30s step %3d of %d, %d iterations, %.1f s  ", pattern_names[pattern_index], m->name,
                step, set->steps, iterations, (double)(clock() - begin) / CLOCKS_PER_SEC);
    }
    fprintf(stderr, "\n");
    if (!status)
        memcpy(s->results[pattern_index][model_index], sb_body_displacements(body),
               (size_t)s->mesh.node_count * sizeof(sb_vec3));
    sb_body_destroy(body);
    return status;
}

/* ---- what comes out -------------------------------------------------------------------------------------------- */

/* Largest and mean distance (mm) between two displacement fields; b NULL: 0. */
static void distances(const study *s, const sb_vec3 *a, const sb_vec3 *b, double *most, double *mean)
{
    *most = *mean = 0;
    for (int i = 0; i < s->mesh.node_count; i++) {
        double d = 1e3 * (double)sb_v3_norm(b ? sb_v3_sub(a[i], b[i]) : a[i]);
        *most = d > *most ? d : *most;
        *mean += d / s->mesh.node_count;
    }
}

static void print_table(const study *s)
{
    double most, mean;
    printf("distance to the reference (mm), maximum / mean\n\n%-30s", "model");
    for (int k = 0; k < PATTERNS; k++)
        printf(" %-16s %-14s", pattern_names[k], "(thesis)");
    printf("\n");
    for (int m = 0; m < MODELS; m++) {
        printf("%-30s", models[m].name);
        for (int k = 0; k < PATTERNS; k++) {
            char own[40];
            distances(s, s->results[k][m], m > 0 ? s->results[k][0] : NULL, &most, &mean);
            snprintf(own, sizeof own, m > 0 ? "%.2f / %.3f" : "moves %.1f / %.2f", most, mean);
            printf(" %-16s %-14s", own, models[m].thesis[k]);
        }
        printf("\n");
    }
    printf("\nWhat the thesis found on its liver: where the organ turns (respiration) the linear model is far off and "
           "all\n"
           "others, which know rotations, are close; where it is only dented they are all alike. How close Jordan and\n"
           "Kim come depends on the shape: they resist changes of volume more than the reference does.\n");
}

/* Writes one result with its distance to the reference. */
static int write_result(study *s, int k, int m)
{
    char path[1024];
    size_t n = (size_t)s->mesh.node_count;
    sb_mesh deformed = s->mesh;
    sb_vec3 *positions = (sb_vec3 *)calloc(n, 2 * sizeof(sb_vec3)), *apart = positions + n;
    sb_field fields[2] = {{"displacement", SB_FIELD_NODES, 3, NULL}, {"from_reference", SB_FIELD_NODES, 3, NULL}};
    sb_error error;
    int status = 0;
    if (!positions)
        return complain_memory();
    for (size_t i = 0; i < n; i++) {
        positions[i] = sb_v3_add(s->mesh.nodes[i], s->results[k][m][i]);
        apart[i] = sb_v3_sub(s->results[k][m][i], s->results[k][0][i]);
    }
    deformed.nodes = positions;
    fields[0].values = &s->results[k][m][0].x;
    fields[1].values = &apart[0].x;
    snprintf(path, sizeof path, "%s/%s_%d.vtk", s->set->folder, pattern_names[k], m);
    if (sb_mesh_save_vtk_binary(path, &deformed, fields, 2, &error) != SB_OK)
        status = complain(path, &error, EXIT_USAGE);
    else
        printf("%s  %s\n", path, models[m].name);
    free(positions);
    return status;
}

static int run(const settings *set)
{
    study s;
    int status;
    memset(&s, 0, sizeof s);
    s.set = set;
    status = make_mesh(&s);
    if (!status)
        status = make_patterns(&s);
    for (int k = 0; k < PATTERNS; k++)
        for (int m = 0; m < MODELS && !status; m++)
            status = solve(&s, k, m);
    if (!status)
        print_table(&s);
    for (int k = 0; k < PATTERNS && set->folder; k++)
        for (int m = 0; m < MODELS && !status; m++)
            status = write_result(&s, k, m);
    release(&s);
    return status;
}

static int program(int argc, char **argv)
{
    settings s = {NULL, NULL, 1, 0.0485, 0.01107, 3, 15, 8, 0};
    const option options[] = {
        {"--steps", "N", OPTION_INTEGER, &s.steps, NULL, NULL, 1, 1e5, "time steps of each deformation"},
        {"--duration", "S", OPTION_NUMBER, NULL, &s.duration, NULL, 1e-3, 1e6, "time (s) it takes"},
        {"--breath", "M", OPTION_NUMBER, NULL, &s.breath, NULL, 0, 1, "largest motion (m) of breathing"},
        {"--dent", "M", OPTION_NUMBER, NULL, &s.dent, NULL, 0, 1, "depth (m) of the instrument's dent"},
        {"--cells", "N", OPTION_INTEGER, &s.cells, NULL, NULL, 4, 60, "without a file: cells over the liver's width"},
        {"--scale", "X", OPTION_NUMBER, NULL, &s.scale, NULL, 1e-9, 1e9,
         "multiplies the file's lengths; 0.001 for millimetres"},
        {"-o", "DIR", OPTION_TEXT, NULL, NULL, &s.folder, 0, 0, "an existing folder for the deformed livers (VTK)"},
        {"--help", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, "this text"},
        {"-h", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, NULL},
    };
    const int count = (int)(sizeof options / sizeof options[0]);
    if (!options_parse("liver_models", options, count, &s.liver, 1, argc, argv))
        return EXIT_USAGE;
    if (s.help) {
        printf("usage: liver_models [LIVER] [OPTIONS]\n\n"
               "Deforms a liver as by breathing and as by an instrument, once with each material of the\n"
               "literature, and prints how far the results are apart. LIVER: a volume mesh in metres (VTK,\n"
               "VTU, gmsh, Medit or TetGen), z towards the head, x to the patient's left; without it one is made.\n\n");
        options_print(options, count);
        return 0;
    }
    return run(&s);
}

int main(int argc, char **argv) { return finish("liver_models", program(argc, argv), EXIT_USAGE); }
