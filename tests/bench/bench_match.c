/* bench_match: registration of a liver of about 6,000 unknowns with its deformed surface, from bodies in place.
 *
 *     match_liver1_tet4    physics-based shape matching to the settled end: liver1 of the shared data, held where it is
 *     match_liver1_tet10   known not to move; liver2 alike; without the data a generated organ that was pressed in
 *     match_organ_tet4     (its truth is then exact)
 *     ..._part             the same from the part of the deformed surface that a camera sees
 *     nicp_...             non-rigid ICP, all its increments: created and run
 *
 * One line per workload:
 *     name n_dof settled_ms min_ms steps steps_per_s create_ms | error_steps error_ms moved_steps moved_ms |
 *     mean_mm max_mm | field system solve (ms per step) pcg | bytes checksum
 * With an argument, `match` or `nicp`, that method alone. Times are medians (min: the least) over 20 runs after one to
 * warm up. error: from when on the largest error of a node
 * against the truth is within 0.1 mm of its final value; moved: from when on no node is more than 0.1 mm from its final
 * place. mean and max are the final errors at the nodes. The checksum is the sum of |u|. Asserts nothing. */
#define SB_IMPLEMENTATION
#define REG_IMPLEMENTATION
#include "register.h"

#include "measure.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { RUNS = 20, MOST_STEPS = 200 };
#define REAL(x) ((sb_real)(x))

static size_t bytes_given;

/* What is registered, and the truth, which only the score sees. */
typedef struct workload {
    const char *name;
    sb_mesh mesh, surface, target;
    int has_surface;       /* 0: the mesh's boundary is matched */
    sb_vec3 *truth;        /* [nodes] displacement (m) */
    unsigned char *scored; /* [nodes] 1: the truth is known there */
    sb_real fixed_below;   /* nodes with (x + z) / sqrt 2 below that do not move (m) */
} workload;

/* ---- workloads ---- */

static int is_fixed(const workload *w, sb_vec3 x) { return (x.x + x.z) * REAL(0.70710678) < w->fixed_below; }

static sb_body *make_body(const workload *w)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_error error;
    def.mesh = &w->mesh;
    def.material = sb_material_corotated(5000, REAL(0.45), 1060);
    def.allocator = counting_allocator(&bytes_given);
    def.clock = now;
    def.jobs = jobs_asked_for();
    if (sb_body_create(&def, &body, &error) != SB_OK) {
        printf("%s: %s\n", w->name, error.message);
        return NULL;
    }
    for (int i = 0; i < w->mesh.node_count; i++)
        if (is_fixed(w, w->mesh.nodes[i]))
            sb_body_fix_nodes(body, &i, 1, SB_XYZ);
    return body;
}

static void free_workload(workload *w)
{
    sb_mesh_free(&w->mesh);
    sb_mesh_free(&w->surface);
    sb_mesh_free(&w->target);
    free(w->truth);
    free(w->scored);
}

static FILE *open_shared(const char *liver, const char *file, char *path, size_t size)
{
    const char *shared = getenv("SHARED");
    snprintf(path, size, "%s/data/insilico/%s/%s", shared ? shared : "../shared", liver, file);
    return fopen(path, "r");
}

static int load_shared(const char *liver, const char *file, sb_mesh *mesh)
{
    char path[1024];
    FILE *there = open_shared(liver, file, path, sizeof path);
    if (!there)
        return 0;
    fclose(there);
    return sb_mesh_load(mesh, path, NULL, NULL) == SB_OK;
}

static int load_truth(workload *w, const char *liver, const char *type)
{
    char path[1024], name[64], line[512];
    double x, y, z;
    int node, inside, count = 0;
    FILE *file;
    snprintf(name, sizeof name, "truth/truth_coarse_%s.txt", type);
    file = open_shared(liver, name, path, sizeof path);
    while (file && fgets(line, sizeof line, file))
        if (sscanf(line, "%d %lf %lf %lf %d", &node, &x, &y, &z, &inside) == 5 && node >= 0 &&
            node < w->mesh.node_count) {
            w->truth[node] = sb_v3(REAL(x), REAL(y), REAL(z));
            w->scored[node] = inside != 0;
            count++;
        }
    if (file)
        fclose(file);
    file = open_shared(liver, "info.json", path, sizeof path);
    while (file && fgets(line, sizeof line, file))
        if (sscanf(line, " \"offset\": %lf", &x) == 1)
            w->fixed_below = REAL(x);
    if (file)
        fclose(file);
    return count == w->mesh.node_count && w->fixed_below > -1;
}

static int make_score(workload *w)
{
    w->truth = (sb_vec3 *)calloc((size_t)w->mesh.node_count, sizeof *w->truth);
    w->scored = (unsigned char *)malloc((size_t)w->mesh.node_count);
    if (!w->truth || !w->scored)
        return 0;
    memset(w->scored, 1, (size_t)w->mesh.node_count);
    return 1;
}

static int load_liver(workload *w, const char *liver, const char *type, const char *target)
{
    char name[64];
    memset(w, 0, sizeof *w);
    w->fixed_below = -SB_REAL_MAX;
    w->has_surface = 1;
    snprintf(name, sizeof name, "coarse_%s.vtk", type);
    if (load_shared(liver, name, &w->mesh) && load_shared(liver, "undeformed_surface.obj", &w->surface) &&
        load_shared(liver, target, &w->target) && make_score(w) && load_truth(w, liver, type))
        return 1;
    free_workload(w);
    return 0;
}

/* Dents the organ by an eighth of its height, all about the point that is highest. */
static sb_result press(workload *w, sb_body *body, const sb_boundary *boundary)
{
    sb_static_options options = sb_default_static_options();
    sb_vec3 low, high, top = w->mesh.nodes[0];
    sb_real depth, width;
    sb_mesh_bounds(&w->mesh, &low, &high);
    depth = (high.z - low.z) / 8;
    width = (high.x - low.x) / 6;
    for (int i = 0; i < w->mesh.node_count; i++)
        top = w->mesh.nodes[i].z > top.z ? w->mesh.nodes[i] : top;
    for (int i = 0; i < boundary->surface.node_count; i++) {
        int node = boundary->nodes[i];
        double r = (double)(sb_v3_norm(sb_v3_sub(w->mesh.nodes[node], top)) / width), share = exp(-0.5 * r * r);
        sb_vec3 way = sb_v3(0, 0, REAL(-share) * depth);
        if (share > 0.1 && !is_fixed(w, w->mesh.nodes[node]))
            sb_body_prescribe(body, &node, 1, SB_XYZ, &way, 1);
    }
    options.load_steps = 4;
    return sb_body_solve_static(body, &options, NULL);
}

/* A generated organ of the same size, dented: its skin is what is seen. */
static int make_organ(workload *w, sb_element_type type)
{
    sb_material tissue = sb_material_stable_neo_hookean(5000, REAL(0.45), 1060);
    sb_boundary boundary;
    sb_body *body;
    sb_vec3 low, high;
    int made = 0;
    memset(w, 0, sizeof *w);
    if (sb_mesh_organ(type, type == SB_TET4 ? 14 : 8, NULL, &w->mesh, NULL) != SB_OK)
        return 0;
    sb_mesh_reorder(&w->mesh, NULL, NULL, NULL);
    sb_mesh_bounds(&w->mesh, &low, &high);
    w->fixed_below = REAL(0.70710678) * (low.x + low.z + REAL(0.4) * (high.x - low.x));
    body = make_body(w);
    if (body && make_score(w) && sb_mesh_boundary(&w->mesh, 1, NULL, &boundary, NULL) == SB_OK) {
        made = sb_body_set_material(body, &tissue, NULL) == SB_OK && press(w, body, &boundary) == SB_OK &&
               sb_surface_triangulate(&boundary.surface, NULL, &w->target, NULL) == SB_OK;
        if (made)
            memcpy(w->truth, sb_body_displacements(body), (size_t)w->mesh.node_count * sizeof *w->truth);
        for (int i = 0; made && i < w->target.node_count; i++)
            w->target.nodes[i] = sb_v3_add(w->target.nodes[i], w->truth[boundary.nodes[i]]);
        sb_boundary_free(&boundary);
    }
    sb_body_destroy(body);
    if (!made)
        free_workload(w);
    return made;
}

/* ---- runs ---- */

/* What one run was like. */
typedef struct course {
    int steps;
    double created, seconds; /* s; all steps */
    double ends[MOST_STEPS]; /* s, of the steps up to each */
    double phases[3];        /* s; all steps: field, system, solve */
    int pcg;
    size_t bytes;
    sb_vec3 *places; /* [MOST_STEPS][nodes] displacements after each step, or NULL: not kept */
} course;

/* After a step: 0 when there is no place for more of them. */
static int keep(const workload *w, const sb_body *body, course *c, double seconds)
{
    size_t n = (size_t)w->mesh.node_count;
    c->ends[c->steps] = c->seconds = seconds;
    if (c->places)
        memcpy(c->places + (size_t)c->steps * n, sb_body_displacements(body), n * sizeof *c->places);
    return ++c->steps < MOST_STEPS;
}

static int run_match(const workload *w, sb_body *body, course *c)
{
    reg_match_def def = reg_default_match_def();
    reg_match *match = NULL;
    reg_match_info info;
    sb_error error;
    double begun = now();
    def.body = body;
    def.surface = w->has_surface ? &w->surface : NULL;
    def.target = &w->target;
    def.clock = now;
    def.allocator = counting_allocator(&bytes_given);
    if (reg_match_create(&def, &match, &error) != SB_OK) {
        printf("%s: %s\n", w->name, error.message);
        return 0;
    }
    c->created = now() - begun;
    info = reg_match_get_info(match);
    while (info.stop == REG_MATCH_RUNNING) {
        if (reg_match_step(match, &info) != SB_OK) {
            printf("%s: %s\n", w->name, info.error.message);
            break;
        }
        c->phases[0] += info.seconds_field;
        c->phases[1] += info.seconds_system;
        c->phases[2] += info.seconds_solve;
        c->pcg += info.pcg_iterations;
        if (!keep(w, body, c, info.seconds))
            break;
    }
    reg_match_destroy(match);
    return c->steps > 0;
}

static int run_nicp(const workload *w, sb_body *body, course *c)
{
    reg_nicp_def def = reg_default_nicp_def();
    reg_nicp *nicp = NULL;
    reg_nicp_info info;
    sb_error error;
    double begun = now();
    def.body = body;
    def.surface = w->has_surface ? &w->surface : NULL;
    def.target = &w->target;
    def.clock = now;
    def.allocator = counting_allocator(&bytes_given);
    if (reg_nicp_create(&def, &nicp, &error) != SB_OK) {
        printf("%s: %s\n", w->name, error.message);
        return 0;
    }
    c->created = now() - begun;
    info = reg_nicp_get_info(nicp);
    while (info.stop == REG_NICP_RUNNING) {
        if (reg_nicp_step(nicp, &info) != SB_OK) {
            printf("%s: %s\n", w->name, info.error.message);
            break;
        }
        c->phases[0] += info.seconds_pairs;
        c->phases[2] += info.seconds_solve;
        c->pcg += info.pcg_iterations;
        if (!keep(w, body, c, info.seconds))
            break;
    }
    reg_nicp_destroy(nicp);
    return c->steps > 0;
}

typedef int run_method(const workload *w, sb_body *body, course *c);

/* Errors (mm) of a shape at the nodes whose truth is known. */
static double score(const workload *w, const sb_vec3 *u, double *most)
{
    double sum = 0;
    int count = 0;
    *most = 0;
    for (int i = 0; i < w->mesh.node_count; i++)
        if (w->scored[i]) {
            double error = 1e3 * (double)sb_v3_norm(sb_v3_sub(u[i], w->truth[i]));
            sum += error;
            *most = fmax(*most, error);
            count++;
        }
    return count ? sum / count : 0;
}

static double farthest(const workload *w, const sb_vec3 *u, const sb_vec3 *v)
{
    double most = 0;
    for (int i = 0; i < w->mesh.node_count; i++)
        most = fmax(most, 1e3 * (double)sb_v3_norm(sb_v3_sub(u[i], v[i])));
    return most;
}

/* Steps after which the error, and the shape, stay within 0.1 mm of what they are in the end. */
static void find_ends(const workload *w, const course *c, int *error_steps, int *moved_steps)
{
    size_t n = (size_t)w->mesh.node_count;
    const sb_vec3 *last = c->places + (size_t)(c->steps - 1) * n;
    double most, end;
    (void)score(w, last, &end);
    *error_steps = *moved_steps = 1;
    for (int k = 0; k < c->steps; k++) {
        const sb_vec3 *u = c->places + (size_t)k * n;
        (void)score(w, u, &most);
        if (fabs(most - end) > 0.1)
            *error_steps = k + 2;
        if (farthest(w, u, last) > 0.1)
            *moved_steps = k + 2;
    }
}

static void run(const workload *w, const char *method, run_method *go)
{
    double settled[RUNS], created[RUNS], error_ends[RUNS], moved_ends[RUNS], phases[3] = {0, 0, 0}, sum = 0, mean = 0;
    double most = 0;
    int error_steps = 1, moved_steps = 1, steps = 0, pcg = 0;
    size_t n = (size_t)w->mesh.node_count, bytes = 0;
    sb_vec3 *places = (sb_vec3 *)malloc((size_t)MOST_STEPS * n * sizeof *places);
    for (int k = -1; places && k < RUNS; k++) {
        course c;
        sb_body *body;
        int done;
        memset(&c, 0, sizeof c);
        c.places = k < 0 ? places : NULL;
        bytes_given = 0;
        body = make_body(w);
        done = body && go(w, body, &c);
        if (done && k < 0) {
            find_ends(w, &c, &error_steps, &moved_steps);
            mean = score(w, sb_body_displacements(body), &most);
            for (size_t i = 0; i < n; i++)
                sum += (double)sb_v3_norm(sb_body_displacements(body)[i]);
            bytes = bytes_given;
            steps = c.steps;
            pcg = c.pcg;
        }
        sb_body_destroy(body);
        if (!done || c.steps != steps) {
            free(places);
            return;
        }
        if (k < 0)
            continue;
        settled[k] = c.seconds;
        created[k] = c.created;
        error_ends[k] = c.ends[error_steps - 1];
        moved_ends[k] = c.ends[moved_steps - 1];
        for (int p = 0; p < 3; p++)
            phases[p] += c.phases[p] / (RUNS * c.steps);
    }
    free(places);
    if (steps == 0)
        return;
    printf("%s_%-18s %6d %8.1f ", method, w->name, 3 * w->mesh.node_count, 1e3 * median(settled, RUNS));
    printf("%8.1f %4d %6.1f %7.1f | ", 1e3 * settled[0], steps, steps / median(settled, RUNS),
           1e3 * median(created, RUNS));
    printf("%3d %8.1f %3d %8.1f | ", error_steps, 1e3 * median(error_ends, RUNS), moved_steps,
           1e3 * median(moved_ends, RUNS));
    printf("%.3f %.2f | %.2f %.2f %.2f %.1f | %lu %.9e\n", mean, most, 1e3 * phases[0], 1e3 * phases[1],
           1e3 * phases[2], (double)pcg / steps, (unsigned long)bytes, sum);
    fflush(stdout);
}

static const char *only; /* method, or NULL: both */

static void run_both(const workload *w)
{
    if (!only || strcmp(only, "match") == 0)
        run(w, "match", run_match);
    if (!only || strcmp(only, "nicp") == 0)
        run(w, "nicp", run_nicp);
}

static void run_liver(const char *liver, const char *type, int part)
{
    char name[64];
    workload w;
    snprintf(name, sizeof name, "%s_%s%s", liver, type, part ? "_part" : "");
    if (!load_liver(&w, liver, type, part ? "partial_deformed_surface.obj" : "deformed_surface.obj"))
        return;
    w.name = name;
    run_both(&w);
    free_workload(&w);
}

static void run_organ(const char *name, sb_element_type type)
{
    workload w;
    if (!make_organ(&w, type))
        return;
    w.name = name;
    run_both(&w);
    free_workload(&w);
}

int main(int argc, char **argv)
{
    workload probe;
    int shared;
    only = argc > 1 ? argv[1] : NULL;
    shared = load_liver(&probe, "liver1", "tet4", "deformed_surface.obj");
    if (shared)
        free_workload(&probe);
    printf("# name n_dof settled_ms min_ms steps steps_per_s create_ms | error_steps error_ms moved_steps moved_ms | "
           "mean_mm max_mm | field system solve pcg | bytes checksum\n");
    if (!shared) {
        run_organ("organ_tet4", SB_TET4);
        run_organ("organ_tet10", SB_TET10);
        return 0;
    }
    run_liver("liver1", "tet4", 0);
    run_liver("liver1", "tet10", 0);
    run_liver("liver2", "tet4", 0);
    run_liver("liver2", "tet10", 0);
    run_liver("liver1", "tet4", 1);
    run_liver("liver1", "tet10", 1);
    return 0;
}
