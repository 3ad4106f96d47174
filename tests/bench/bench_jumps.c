/* bench_jumps: multigrid, told the moduli, where they jump by 1:1000 between parts of a beam: the linear system of one
 * implicit step (dt 10 ms, beta 0.02 s) and that of rest, 50 kPa, nu 0.45, from a zero start, with parts of every shape
 * of stiff_parts.h beside the even beam. One line each:
 *     mesh unknowns parts state its_1e-2 its_1e-6 times_even_1e-2 times_even_1e-6 | setup_ms solve_ms (to 1e-2)
 * and at the end the largest of each of the two ratios. Linear meshes are shaken by 0.15 of a cell. Asserts nothing;
 * ends with 1 when a system is not solved. */
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "elastic.h"
#include "scene.h"
#include "stiff_parts.h"

enum { REPEATS = 3 };

static const double tolerances[2] = {1e-2, 1e-6};
static const char *const part_names[STIFF_COUNT] = {"even",  "block", "touching",   "slabs",
                                                    "sheet", "rod",   "inclusions", "specks"};

typedef struct beam {
    const char *name;
    sb_mesh mesh;
    int corners;
    sb_matrix matrix;
    unsigned char *mask; /* [nodes] */
    sb_real *rhs, *x;    /* [3 nodes] */
    sb_real *factors;    /* [elements] of the modulus */
    sb_real *moduli;     /* [blocks] */
    sb_pcg_workspace workspace;
} beam;

typedef struct outcome {
    int iterations[2];   /* of the tolerances */
    double setup, solve; /* ms, least; the solve to the first tolerance */
} outcome;

static void stop(const char *name, const char *why)
{
    fprintf(stderr, "bench_jumps: %s: %s\n", name, why);
    exit(1);
}

/* 3n x n x n cells, clamped at x = 0. */
static beam beam_make(const char *name, sb_element_type type, int n)
{
    beam b;
    sb_error error;
    size_t nodes, elements;
    memset(&b, 0, sizeof b);
    b.name = name;
    b.corners = type == SB_TET10 ? 10 : 4;
    b.mesh =
        scene_box(type, 3 * n, n, n, sb_v3((sb_real)0.18, (sb_real)0.06, (sb_real)0.06), type == SB_TET10 ? 0 : 0.15);
    if (sb_mesh_reorder(&b.mesh, NULL, NULL, &error) ||
        sb_matrix_create(b.mesh.node_count, b.mesh.element_count, b.corners, NULL, b.mesh.elements, NULL, &b.matrix,
                         &error) ||
        sb_pcg_workspace_create(b.mesh.node_count, NULL, &b.workspace, &error))
        stop(name, error.message);
    nodes = (size_t)b.mesh.node_count;
    elements = (size_t)b.mesh.element_count;
    b.mask = (unsigned char *)calloc(nodes, 1);
    b.rhs = (sb_real *)calloc(3 * nodes, sizeof(sb_real));
    b.x = (sb_real *)calloc(3 * nodes, sizeof(sb_real));
    b.factors = (sb_real *)calloc(elements, sizeof(sb_real));
    b.moduli = (sb_real *)calloc((size_t)b.matrix.block_count, sizeof(sb_real));
    if (!b.mask || !b.rhs || !b.x || !b.factors || !b.moduli)
        stop(name, "out of memory");
    for (size_t i = 0; i < nodes; i++)
        b.mask[i] = b.mesh.nodes[i].x <= 0 ? SB_XYZ : 0;
    return b;
}

static void beam_free(beam *b)
{
    sb_pcg_workspace_free(&b->workspace);
    sb_matrix_free(&b->matrix);
    sb_mesh_free(&b->mesh);
    free(b->mask);
    free(b->rhs);
    free(b->x);
    free(b->factors);
    free(b->moduli);
}

static void assemble(beam *b, stiff_parts parts, int at_rest)
{
    elastic_system system = {50e3, 0.45, NULL, 0};
    sb_error error;
    for (int t = 0; t < b->mesh.element_count; t++) {
        const int *tet = b->mesh.elements + (size_t)b->corners * (size_t)t;
        b->factors[t] = stiff_parts_hold_tet(parts, b->mesh.nodes, tet, 0.06) ? 1000 : 1;
    }
    system.factors = b->factors;
    system.at_rest = at_rest;
    sb_matrix_clear(&b->matrix);
    memset(b->rhs, 0, 3 * (size_t)b->mesh.node_count * sizeof(sb_real));
    elastic_assemble(b->mesh.nodes, b->mesh.elements, b->mesh.element_count, b->corners, &system, &b->matrix, b->rhs);
    sb_matrix_constrain(&b->matrix, b->mask, NULL, b->rhs);
    if (sb_preconditioner_moduli(&b->matrix, b->mesh.element_count, b->corners, b->mesh.elements, b->factors, b->moduli,
                                 &error))
        stop(b->name, error.message);
}

static outcome solve(beam *b, const sb_jobs *jobs)
{
    sb_preconditioner_def def = sb_default_preconditioner_def();
    sb_pcg_options options = sb_default_pcg_options();
    sb_preconditioner *multigrid = NULL;
    sb_error error;
    outcome found = {{0, 0}, 0, 0};
    def.kind = SB_PRECOND_MULTIGRID;
    def.positions = b->mesh.nodes;
    def.moduli = b->moduli;
    def.poisson = (sb_real)0.45;
    def.jobs = *jobs;
    options.jobs = jobs;
    if (sb_preconditioner_create(&def, &b->matrix, NULL, &multigrid, &error))
        stop(b->name, error.message);
    for (int k = 0; k < REPEATS; k++) {
        double began = now(), taken;
        if (sb_preconditioner_update(multigrid, &b->matrix, NULL, &error))
            stop(b->name, error.message);
        taken = 1e3 * (now() - began);
        found.setup = k == 0 || taken < found.setup ? taken : found.setup;
    }
    for (int t = 0; t < 2; t++)
        for (int k = 0; k < (t ? 1 : REPEATS); k++) {
            sb_pcg_info info;
            sb_result result;
            double began = now(), taken;
            options.tolerance = tolerances[t];
            memset(b->x, 0, 3 * (size_t)b->mesh.node_count * sizeof(sb_real));
            result = sb_pcg_solve(&b->matrix, multigrid, b->rhs, b->x, &options, &b->workspace, &info);
            if (result != SB_OK)
                stop(b->name, sb_result_string(result));
            taken = 1e3 * (now() - began);
            found.iterations[t] = info.iterations;
            if (t == 0)
                found.solve = k == 0 || taken < found.solve ? taken : found.solve;
        }
    sb_preconditioner_free(multigrid);
    return found;
}

/* Raises most[] to the ratios of this mesh. */
static void run(const char *name, sb_element_type type, int n, const sb_jobs *jobs, double *most)
{
    beam b = beam_make(name, type, n);
    for (int at_rest = 0; at_rest < 2; at_rest++) {
        outcome even = {{1, 1}, 0, 0};
        for (int parts = 0; parts < STIFF_COUNT; parts++) {
            outcome found;
            assemble(&b, (stiff_parts)parts, at_rest);
            found = solve(&b, jobs);
            even = parts == STIFF_EVEN ? found : even;
            printf("%-12s %7d %-10s %-7s %3d %3d", name, 3 * b.mesh.node_count, part_names[parts],
                   at_rest ? "at_rest" : "moving", found.iterations[0], found.iterations[1]);
            for (int t = 0; t < 2; t++) {
                double ratio = (double)found.iterations[t] / even.iterations[t];
                most[t] = ratio > most[t] ? ratio : most[t];
                printf(" %5.2f", ratio);
            }
            printf(" | %8.2f %8.2f\n", found.setup, found.solve);
            fflush(stdout);
        }
    }
    beam_free(&b);
}

int main(void)
{
    sb_jobs jobs = jobs_asked_for();
    double most[2] = {0, 0};
    printf("# mesh unknowns parts state its_1e-2 its_1e-6 times_even_1e-2 times_even_1e-6 | setup_ms solve_ms\n");
    run("tet4", SB_TET4, 7, &jobs, most);
    run("tet4", SB_TET4, 12, &jobs, most);
    run("tet4", SB_TET4, 22, &jobs, most);
    run("tet4", SB_TET4, 31, &jobs, most);
    run("tet10", SB_TET10, 8, &jobs, most);
    printf("# at most %.2f and %.2f times the iterations of the even beam to 1e-2 and 1e-6\n", most[0], most[1]);
    return 0;
}
