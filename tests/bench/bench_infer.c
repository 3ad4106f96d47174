/* bench_infer: all that it takes to infer a liver of about 6,000 unknowns from a view of its deformed surface.
 *
 *     infer_liver1_tet4_noisy   liver1 of the shared data from the part that a camera sees, with 1 mm of noise
 *     infer_liver1_tet10_noisy
 *     infer_liver1_tet4_held    the same, held where it is known not to move
 *     infer_liver2_tet4         the whole surface of liver2
 *
 * One line per workload, processor time (ms), the least of RUNS runs:
 *     name n_dof all | model start infer | response choice draws rounds | mean_mm expected_mm checksum
 * all: model, rigid start, inference; response, choice, draws: of the inference. mean: error at the nodes whose truth
 * is known. The checksum is the sum of |u|. Needs the shared data; asserts nothing. */
#define SB_IMPLEMENTATION
#define REG_IMPLEMENTATION
#include "register.h"

#include "measure.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { RUNS = 5, TIMES = 6 };
#define REAL(x) ((sb_real)(x))

/* What is registered, and the truth, which only the score sees. */
typedef struct workload {
    sb_mesh mesh, surface, target;
    sb_vec3 *truth; /* [nodes] displacement (m) */
    int *scored;    /* [nodes] 1: the truth is known there */
    int *fixed;     /* [fixed_count] */
    int fixed_count;
} workload;

/* Processor time (s). */
static double spent(void) { return (double)clock() / CLOCKS_PER_SEC; }

static void free_workload(workload *w)
{
    sb_mesh_free(&w->mesh);
    sb_mesh_free(&w->surface);
    sb_mesh_free(&w->target);
    free(w->truth);
    free(w->scored);
    free(w->fixed);
}

static void name_file(const char *liver, const char *file, char *path, size_t size)
{
    const char *shared = getenv("SHARED");
    snprintf(path, size, "%s/data/insilico/%s/%s", shared ? shared : "../shared", liver, file);
}

static int load_mesh(const char *liver, const char *file, sb_mesh *mesh)
{
    char path[1024];
    name_file(liver, file, path, sizeof path);
    return sb_mesh_load(mesh, path, NULL, NULL) == SB_OK;
}

static int load_truth(workload *w, const char *liver, const char *type)
{
    char path[1024], name[64], line[512];
    double x, y, z;
    int node, inside, count = 0;
    FILE *file;
    snprintf(name, sizeof name, "truth/truth_coarse_%s.txt", type);
    name_file(liver, name, path, sizeof path);
    file = fopen(path, "r");
    while (file && fgets(line, sizeof line, file))
        if (sscanf(line, "%d %lf %lf %lf %d", &node, &x, &y, &z, &inside) == 5 && node >= 0 &&
            node < w->mesh.node_count) {
            w->truth[node] = sb_v3(REAL(x), REAL(y), REAL(z));
            w->scored[node] = inside != 0;
            count++;
        }
    if (file)
        fclose(file);
    return count == w->mesh.node_count;
}

/* Nodes with (x + z) / sqrt 2 below what the file says do not move. */
static void load_fixed(workload *w, const char *liver)
{
    char path[1024], line[512];
    double offset = -SB_REAL_MAX;
    FILE *file;
    name_file(liver, "info.json", path, sizeof path);
    file = fopen(path, "r");
    while (file && fgets(line, sizeof line, file))
        (void)sscanf(line, " \"offset\": %lf", &offset);
    if (file)
        fclose(file);
    for (int i = 0; i < w->mesh.node_count; i++)
        if ((double)(w->mesh.nodes[i].x + w->mesh.nodes[i].z) * 0.70710678 < offset)
            w->fixed[w->fixed_count++] = i;
}

static int load_liver(workload *w, const char *liver, const char *type, const char *target, int held)
{
    char name[64];
    size_t nodes;
    memset(w, 0, sizeof *w);
    snprintf(name, sizeof name, "coarse_%s.vtk", type);
    if (!load_mesh(liver, name, &w->mesh) || !load_mesh(liver, "undeformed_surface.obj", &w->surface) ||
        !load_mesh(liver, target, &w->target))
        return 0;
    nodes = (size_t)w->mesh.node_count;
    w->truth = (sb_vec3 *)calloc(nodes, sizeof *w->truth);
    w->scored = (int *)calloc(nodes, sizeof *w->scored);
    w->fixed = (int *)calloc(nodes, sizeof *w->fixed);
    if (!w->truth || !w->scored || !w->fixed || !load_truth(w, liver, type))
        return 0;
    if (held)
        load_fixed(w, liver);
    return 1;
}

/* ---- runs ---- */

static int align(const workload *w, int part, reg_rigid *motion)
{
    reg_icp_options options = reg_default_icp_options();
    const sb_mesh *meshes[2] = {&w->surface, &w->target};
    reg_icp_shape shapes[2];
    reg_cloud clouds[2];
    sb_surface *trees[2] = {NULL, NULL};
    int good = 1;
    memset(shapes, 0, sizeof shapes);
    memset(clouds, 0, sizeof clouds);
    for (int k = 0; k < 2; k++) {
        good = good && reg_cloud_from_mesh(clouds + k, meshes[k], NULL, NULL) == SB_OK &&
               sb_surface_create(meshes[k], NULL, trees + k, NULL) == SB_OK;
        shapes[k].points = clouds[k].points;
        shapes[k].normals = clouds[k].normals;
        shapes[k].count = clouds[k].count;
        shapes[k].surface = trees[k];
    }
    options.overlap = part ? REG_ICP_TARGET_PART : REG_ICP_WHOLE;
    good = good && reg_icp(shapes, shapes + 1, &options, motion, NULL, NULL) == SB_OK;
    for (int k = 0; k < 2; k++) {
        reg_cloud_free(clouds + k);
        sb_surface_destroy(trees[k]);
    }
    return good;
}

static reg_model *make_model(const workload *w)
{
    reg_model_def def = reg_default_model_def();
    reg_model *model = NULL;
    def.mesh = &w->mesh;
    def.surface = &w->surface;
    def.fixed = w->fixed_count ? w->fixed : NULL;
    def.fixed_count = w->fixed_count;
    return reg_model_create(&def, &model, NULL) == SB_OK ? model : NULL;
}

/* Mean error (mm) where the truth is known, and the sum of |u| (m). */
static double score(const workload *w, const reg_infer *infer, double *sum)
{
    sb_vec3 *u = (sb_vec3 *)malloc((size_t)w->mesh.node_count * sizeof *u);
    double error = 0;
    int count = 0;
    *sum = 0;
    (void)reg_infer_displacements(infer, u);
    for (int i = 0; i < w->mesh.node_count; i++) {
        *sum += (double)sb_v3_norm(u[i]);
        error += w->scored[i] ? 1e3 * (double)sb_v3_norm(sb_v3_sub(u[i], w->truth[i])) : 0;
        count += w->scored[i];
    }
    free(u);
    return error / count;
}

/* One run: times[TIMES] of model, start, inference, and in this response, choice, draws (s). */
static reg_infer *infer_once(const workload *w, int part, reg_model **model, double *times)
{
    reg_infer_def def = reg_default_infer_def();
    reg_infer *infer = NULL;
    reg_quality quality;
    sb_error error;
    double begun = spent();
    *model = make_model(w);
    times[0] = spent() - begun;
    begun = spent();
    if (!*model || !align(w, part, &def.start))
        return NULL;
    times[1] = spent() - begun;
    def.model = *model;
    def.target.surface = &w->target;
    def.clock = spent;
    if (reg_infer_run(&def, &infer, &error) != SB_OK) {
        printf("%s\n", error.message);
        return NULL;
    }
    (void)reg_infer_get_quality(infer, &quality);
    times[2] = quality.seconds;
    times[3] = quality.seconds_response;
    times[4] = quality.seconds_choice;
    times[5] = quality.seconds_draws;
    return infer;
}

static void run(const char *liver, const char *type, const char *target, const char *words, int held)
{
    double least[TIMES], all = 1e300, mean = 0, sum = 0;
    int part = strncmp(target, "partial", 7) == 0, runs = getenv("BENCH_RUNS") ? atoi(getenv("BENCH_RUNS")) : RUNS;
    reg_quality quality;
    workload w;
    memset(&quality, 0, sizeof quality);
    for (int t = 0; t < TIMES; t++)
        least[t] = 1e300;
    if (!load_liver(&w, liver, type, target, held)) {
        free_workload(&w);
        return;
    }
    for (int k = 0; k < runs; k++) {
        double times[TIMES];
        reg_model *model = NULL;
        reg_infer *infer = infer_once(&w, part, &model, times);
        if (infer) {
            mean = score(&w, infer, &sum);
            (void)reg_infer_get_quality(infer, &quality);
            all = fmin(all, times[0] + times[1] + times[2]);
            for (int t = 0; t < TIMES; t++)
                least[t] = fmin(least[t], times[t]);
        }
        reg_infer_destroy(infer);
        reg_model_destroy(model);
    }
    printf("infer_%s_%s%-7s %5d %7.1f | ", liver, type, words, 3 * w.mesh.node_count, 1e3 * all);
    printf("%6.1f %6.1f %7.1f | %7.1f %6.1f %6.1f %d | ", 1e3 * least[0], 1e3 * least[1], 1e3 * least[2],
           1e3 * least[3], 1e3 * least[4], 1e3 * least[5], quality.rounds);
    printf("%.4f %.4f %.12e\n", mean, 1e3 * (double)quality.expected, sum);
    fflush(stdout);
    free_workload(&w);
}

/* With a number: that workload alone, from 1. */
int main(int argc, char **argv)
{
    int only = argc > 1 ? atoi(argv[1]) : 0;
    printf("# name n_dof all | model start infer | response choice draws rounds | mean_mm expected_mm checksum\n");
    if (only == 0 || only == 1)
        run("liver1", "tet4", "partial_deformed_surface_noisy.obj", "_noisy", 0);
    if (only == 0 || only == 2)
        run("liver1", "tet10", "partial_deformed_surface_noisy.obj", "_noisy", 0);
    if (only == 0 || only == 3)
        run("liver1", "tet4", "partial_deformed_surface_noisy.obj", "_held", 1);
    if (only == 0 || only == 4)
        run("liver2", "tet4", "deformed_surface.obj", "", 0);
    return 0;
}
