/* bench_identify: gradients and identification on a liver of tet10, beside the static solve that they follow.
 *
 * bench_identify [CELLS [SHARE]]: over its width, of gravity; default 9, 1. Held at one side, pulled by gravity along
 * three axes as in three states; two moduli of stable neo-Hookean material, of the tissue and of a ball in it. Prints
 *     identify_solve n_dof n_elements seconds newton                 the static solve, from rest
 *     identify_gradient PARAMETERS seconds in_newton_iterations      sb_body_gradient, all kinds of its elements
 *     identify_columns PARAMETERS seconds in_newton_iterations       sb_body_sensitivities of the same
 *     identify_moduli seconds steps solves E1 E2                     three states, all nodes of one side seen, from 1/3
 * Processor time, the least of five gradients. Asserts nothing. */
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "measure.h"

#include <stdio.h>
#include <string.h>

enum { TURNS = 5, STATES = 3, MOST = 6 };

typedef struct world {
    sb_mesh mesh;
    sb_body *body;
    sb_vec3 *points[STATES]; /* [nodes] */
    int *seen, *starts;      /* nodes that are seen */
    sb_real *weights;
    int seen_count;
    sb_real share; /* of gravity */
} world;

static const double tissue = 12000, core = 48000; /* Pa */

static double used(void) { return (double)clock() / CLOCKS_PER_SEC; }

static sb_result pull(void *user, int state, const sb_real *free_values, sb_body *body, sb_error *error)
{
    static const sb_vec3 g[STATES] = {{0, 0, (sb_real)-9.81}, {0, (sb_real)9.81, 0}, {0, 0, (sb_real)9.81}};
    (void)free_values, (void)error;
    return sb_body_set_gravity(body, sb_v3_scale(((const world *)user)->share, g[state]));
}

static int make(world *w, int cells)
{
    sb_body_def def = sb_default_body_def();
    sb_region_material inner;
    sb_vec3 low = {0, 0, 0}, high = {0, 0, 0}, middle;
    if (sb_mesh_organ(SB_TET10, cells, NULL, &w->mesh, NULL) != SB_OK)
        return 0;
    sb_mesh_bounds(&w->mesh, &low, &high);
    middle = sb_v3_scale((sb_real)0.5, sb_v3_add(low, high));
    if (!w->mesh.regions)
        w->mesh.regions = (int *)calloc((size_t)w->mesh.element_count, sizeof(int));
    for (int e = 0; e < w->mesh.element_count && w->mesh.regions; e++)
        w->mesh.regions[e] =
            sb_v3_norm(sb_v3_sub(w->mesh.nodes[w->mesh.elements[10 * e]], middle)) < (sb_real)0.25 * (high.x - low.x);
    inner.region = 1;
    inner.material = sb_material_stable_neo_hookean((sb_real)core, (sb_real)0.45, 1060);
    def.mesh = &w->mesh;
    def.material = sb_material_stable_neo_hookean((sb_real)tissue, (sb_real)0.45, 1060);
    def.region_materials = &inner;
    def.region_material_count = 1;
    w->seen = (int *)calloc((size_t)w->mesh.node_count, sizeof(int));
    w->starts = (int *)calloc((size_t)w->mesh.node_count + 1, sizeof(int));
    w->weights = (sb_real *)calloc((size_t)w->mesh.node_count, sizeof(sb_real));
    if (!w->mesh.regions || !w->seen || !w->starts || !w->weights || sb_body_create(&def, &w->body, NULL) != SB_OK)
        return 0;
    for (int i = 0; i < w->mesh.node_count; i++) {
        sb_real x = w->mesh.nodes[i].x;
        if (x < low.x + (sb_real)0.1 * (high.x - low.x))
            sb_body_fix_nodes(w->body, &i, 1, SB_XYZ);
        if (x < middle.x)
            continue;
        w->weights[w->seen_count] = 1;
        w->starts[w->seen_count + 1] = w->seen_count + 1;
        w->seen[w->seen_count++] = i;
    }
    for (int k = 0; k < STATES; k++)
        w->points[k] = (sb_vec3 *)calloc((size_t)w->mesh.node_count, sizeof(sb_vec3));
    return w->points[0] && w->points[1] && w->points[2];
}

static void list_parameters(sb_parameter *p)
{
    memset(p, 0, MOST * sizeof *p);
    for (int k = 0; k < MOST; k++) {
        static const sb_parameter_kind kinds[3] = {SB_PARAMETER_YOUNG, SB_PARAMETER_POISSON, SB_PARAMETER_DENSITY};
        p[k].kind = kinds[k / 2];
        p[k].region = k % 2;
    }
}

static void run_derivatives(world *w)
{
    sb_static_options options = sb_default_static_options();
    sb_parameter p[MOST];
    sb_real slopes[MOST];
    size_t n = (size_t)w->mesh.node_count;
    sb_vec3 *loss = (sb_vec3 *)calloc(n, sizeof *loss), *columns = (sb_vec3 *)calloc(MOST * n, sizeof *columns);
    sb_step_info info;
    double solve, least[2] = {1e30, 1e30};
    pull(w, 0, NULL, w->body, NULL);
    options.tolerance = (sb_real)1e-9;
    solve = used();
    if (!loss || !columns || sb_body_solve_static(w->body, &options, &info) != SB_OK)
        return;
    solve = used() - solve;
    printf("identify_solve %d %d %.3f %d\n", 3 * w->mesh.node_count, w->mesh.element_count, solve,
           info.newton_iterations);
    list_parameters(p);
    loss[w->seen[w->seen_count / 2]].z = 1;
    for (int turn = 0; turn < TURNS; turn++) {
        double began = used(), half;
        sb_body_gradient(w->body, loss, NULL, p, MOST, slopes, NULL, NULL);
        half = used();
        sb_body_sensitivities(w->body, p, MOST, columns, NULL, NULL);
        least[0] = fmin(least[0], half - began);
        least[1] = fmin(least[1], used() - half);
    }
    solve /= info.newton_iterations;
    printf("identify_gradient %d %.3f %.2f\n", (int)MOST, least[0], least[0] / solve);
    printf("identify_columns %d %.3f %.2f\n", (int)MOST, least[1], least[1] / solve);
    free(loss);
    free(columns);
}

static void run_identify(world *w)
{
    sb_identify_def def = sb_default_identify_def();
    sb_measurement seen[STATES];
    sb_mapping rows;
    sb_parameter p[MOST];
    sb_real values[2] = {(sb_real)(tissue / 3), (sb_real)(core / 3)}, deviations[2], shares[2];
    sb_identify_info info;
    sb_error error;
    double began;
    memset(&rows, 0, sizeof rows);
    memset(seen, 0, sizeof seen);
    rows.row_count = w->seen_count;
    rows.row_start = w->starts;
    rows.nodes = w->seen;
    rows.weights = w->weights;
    for (int k = 0; k < STATES; k++) {
        if (pull(w, k, NULL, w->body, NULL) != SB_OK || sb_body_solve_static(w->body, NULL, NULL) != SB_OK)
            return;
        for (int i = 0; i < w->seen_count; i++)
            w->points[k][i] = sb_body_positions(w->body)[w->seen[i]];
        seen[k].rows = &rows;
        seen[k].points = w->points[k];
        seen[k].sigma_point = (sb_real)1e-4;
    }
    list_parameters(p);
    def.body = w->body;
    def.parameters = p; /* the first two: Young's moduli */
    def.count = 2;
    def.state_count = STATES;
    def.measurements = seen;
    def.apply = pull;
    def.user = w;
    began = used();
    if (sb_identify(&def, values, deviations, shares, &info, &error) != SB_OK)
        printf("identify_moduli: %s\n", error.message);
    else
        printf("identify_moduli %.2f %d %d %.6g %.6g\n", used() - began, info.iterations, info.solves,
               (double)values[0], (double)values[1]);
}

int main(int argc, char **argv)
{
    world w;
    int good;
    memset(&w, 0, sizeof w);
    w.share = argc > 2 ? (sb_real)atof(argv[2]) : 1;
    good = make(&w, argc > 1 ? atoi(argv[1]) : 9);
    if (good) {
        run_derivatives(&w);
        run_identify(&w);
    }
    sb_body_destroy(w.body);
    for (int k = 0; k < STATES; k++)
        free(w.points[k]);
    free(w.seen);
    free(w.starts);
    free(w.weights);
    sb_mesh_free(&w.mesh);
    return !good;
}
