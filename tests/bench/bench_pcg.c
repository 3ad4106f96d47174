/* bench_pcg: the linear system of one implicit step of a cantilever under gravity, solved with every
 * preconditioner. Prints one line per kind: name, dof, pieces of the coarse space, set-up ms (median), and
 * per tolerance iterations and ms of the solve (medians of up to 21 runs, fewer where they take long).
 * Asserts nothing. */
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "elastic.h"

#include "measure.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* ---- the system ---- */

typedef struct beam {
    int nodes, tets, corners; /* corners: nodes of an element, 4 or 10 */
    int *cells;
    sb_vec3 *positions;
    unsigned char *mask;
    sb_matrix matrix;
    sb_real *rhs, *x;
} beam;

static const double beam_size[3] = {0.2, 0.06, 0.06};

/* Six tetrahedra per cube; n counts cubes. Nodes of quadratic elements lie on the grid of half the size. */
static void beam_mesh(beam *b, const int *n, int corners)
{
    static const int paths[6][3] = {{0, 1, 2}, {0, 2, 1}, {1, 0, 2}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}};
    int half = corners == 10 ? 2 : 1, points[3];
    for (int axis = 0; axis < 3; axis++)
        points[axis] = half * n[axis] + 1;
    b->corners = corners;
    b->nodes = points[0] * points[1] * points[2];
    b->tets = 6 * n[0] * n[1] * n[2];
    b->cells = (int *)malloc(sizeof(int) * (size_t)corners * (size_t)b->tets);
    b->positions = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)b->nodes);
    b->mask = (unsigned char *)calloc((size_t)b->nodes, 1);
    for (int node = 0; node < b->nodes; node++) {
        int at[3] = {node / (points[1] * points[2]), node / points[2] % points[1], node % points[2]};
        b->positions[node] =
            sb_v3((sb_real)(beam_size[0] * at[0] / (points[0] - 1)), (sb_real)(beam_size[1] * at[1] / (points[1] - 1)),
                  (sb_real)(beam_size[2] * at[2] / (points[2] - 1)));
        b->mask[node] = at[0] == 0 ? SB_XYZ : 0;
    }
    for (int t = 0; t < b->tets; t++) {
        int cube = t / 6, *out = b->cells + (size_t)corners * (size_t)t, grid[4][3];
        int at[3] = {cube / (n[1] * n[2]), cube / n[2] % n[1], cube % n[2]};
        for (int v = 0; v < 4; v++) {
            for (int axis = 0; axis < 3; axis++)
                grid[v][axis] = half * at[axis];
            out[v] = (grid[v][0] * points[1] + grid[v][1]) * points[2] + grid[v][2];
            at[v < 3 ? paths[t % 6][v] : 0]++;
        }
        for (int e = 0; e < corners - 4; e++) {
            int middle[3];
            for (int axis = 0; axis < 3; axis++)
                middle[axis] = (grid[elastic_edges[e][0]][axis] + grid[elastic_edges[e][1]][axis]) / 2;
            out[4 + e] = (middle[0] * points[1] + middle[1]) * points[2] + middle[2];
        }
    }
}

/* Linear elasticity: M / dt^2 + (1 + beta / dt) K with lumped masses, gravity on the right. */
static void beam_assemble(beam *b, double young, double poisson)
{
    const elastic_system system = {young, poisson, NULL, 0};
    sb_error error;
    if (sb_matrix_create(b->nodes, b->tets, b->corners, NULL, b->cells, NULL, &b->matrix, &error))
        exit(1);
    b->rhs = (sb_real *)calloc(3 * (size_t)b->nodes, sizeof(sb_real));
    b->x = (sb_real *)calloc(3 * (size_t)b->nodes, sizeof(sb_real));
    elastic_assemble(b->positions, b->cells, b->tets, b->corners, &system, &b->matrix, b->rhs);
    sb_matrix_constrain(&b->matrix, b->mask, NULL, b->rhs);
}

static void beam_free(beam *b)
{
    sb_matrix_free(&b->matrix);
    free(b->cells);
    free(b->positions);
    free(b->mask);
    free(b->rhs);
    free(b->x);
}

/* ---- timing ---- */

enum { REPEATS = 21 };

static const struct {
    const char *name;
    sb_precond_kind kind;
    int power, most_nodes; /* larger meshes are left out */
} smoothers[] = {{"jacobi", SB_PRECOND_BLOCK_JACOBI, 1, 1000000},
                 {"ssor", SB_PRECOND_SSOR, 1, 1000000},
                 {"ic0", SB_PRECOND_IC0, 1, 1000000},
                 {"fsai1", SB_PRECOND_FSAI, 1, 1000000},
                 {"fsai2", SB_PRECOND_FSAI, 2, 10000},
                 {"chol", SB_PRECOND_CHOLESKY, 1, 20000}};

static void bench_kind(const char *mesh, beam *b, int smoother, int pieces, const sb_jobs *jobs)
{
    static const double tolerances[3] = {1e-2, 1e-5, 1e-8};
    sb_preconditioner_def def = sb_default_preconditioner_def();
    sb_pcg_options options = sb_default_pcg_options();
    sb_preconditioner *preconditioner = NULL;
    sb_preconditioner_info resolved;
    sb_pcg_workspace workspace;
    sb_pcg_info info;
    sb_error error;
    double times[REPEATS], began;
    int count;
    def.kind = smoothers[smoother].kind;
    def.power = smoothers[smoother].power;
    def.jobs = *jobs;
    def.positions = b->positions;
    def.piece_count = pieces;
    if (sb_preconditioner_create(&def, &b->matrix, NULL, &preconditioner, &error) ||
        sb_pcg_workspace_create(b->nodes, NULL, &workspace, &error) ||
        sb_preconditioner_update(preconditioner, &b->matrix, NULL, &error)) {
        printf("%s %s: %s\n", mesh, smoothers[smoother].name, error.message);
        exit(1);
    }
    began = now();
    for (count = 0; count < REPEATS && (count == 0 || now() - began < 1); count++) {
        double start = now();
        sb_preconditioner_update(preconditioner, &b->matrix, b->positions, &error);
        times[count] = 1e3 * (now() - start);
    }
    resolved = sb_preconditioner_get_info(preconditioner);
    printf("%-14s %-6s dof %6d pieces %2d shift %-6g bytes %9lu setup %7.3f ms", mesh, smoothers[smoother].name,
           3 * b->nodes, resolved.piece_count, resolved.shift, (unsigned long)resolved.bytes, median(times, count));
    options.jobs = jobs;
    options.max_iterations = 5000;
    for (int t = 0; t < (SB_REAL_IS_FLOAT ? 2 : 3); t++) {
        sb_result result = SB_OK;
        options.tolerance = tolerances[t];
        began = now();
        for (count = 0; count < REPEATS && (count == 0 || now() - began < 1); count++) {
            double start = now();
            memset(b->x, 0, 3 * (size_t)b->nodes * sizeof(sb_real));
            result = sb_pcg_solve(&b->matrix, preconditioner, b->rhs, b->x, &options, &workspace, &info);
            times[count] = 1e3 * (now() - start);
        }
        printf("  %g: %4d it %8.3f ms%s", tolerances[t], info.iterations, median(times, count),
               result == SB_OK ? "" : sb_result_string(result));
    }
    printf("\n");
    sb_pcg_workspace_free(&workspace);
    sb_preconditioner_free(preconditioner);
}

/* Arguments: Poisson's ratio (0.45), then numbers of pieces to try. */
int main(int argc, char **argv)
{
    static const struct {
        const char *name;
        int corners, cubes[3];
    } cases[3] = {
        {"beam_tet4_13k", 4, {22, 10, 10}}, {"beam_tet10_9k", 10, {15, 10, 10}}, {"beam_tet4_106k", 4, {44, 20, 20}}};
    sb_jobs jobs = {NULL, NULL};
#if defined(SB_USE_OPENMP)
    jobs = sb_jobs_openmp();
#endif
    for (int m = 0; m < 3; m++) {
        beam b;
        beam_mesh(&b, cases[m].cubes, cases[m].corners);
        beam_assemble(&b, 50e3, argc > 1 ? atof(argv[1]) : 0.45);
        for (int s = 0; s < (int)(sizeof smoothers / sizeof *smoothers); s++) {
            if (b.nodes > smoothers[s].most_nodes)
                continue;
            bench_kind(cases[m].name, &b, s, 0, &jobs);
            for (int k = 2; k < argc; k++)
                bench_kind(cases[m].name, &b, s, atoi(argv[k]), &jobs);
            if (smoothers[s].kind != SB_PRECOND_CHOLESKY)
                bench_kind(cases[m].name, &b, s, SB_PRECOND_PIECES_AUTO, &jobs);
        }
        beam_free(&b);
    }
    return 0;
}
