/* race_ours: the solvers of softbody.h in the race. Arguments: files of race_write. RACE_SOLVER=ours-multigrid in the
 * environment: that one only. */
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "race.h"

/* Every solver that takes part; one more preconditioner is one more row. */
static const struct {
    const char *name;
    sb_precond_kind kind;
    int most_unknowns; /* larger systems are left to others */
} solvers[] = {{"ours-ic0", SB_PRECOND_IC0, 1000000},
               {"ours-fsai", SB_PRECOND_FSAI, 1000000},
               {"ours-multigrid", SB_PRECOND_MULTIGRID, 1000000},
               {"ours-direct", SB_PRECOND_CHOLESKY, 60000}};

/* The system as the library holds it. */
static void make_matrix(const race_system *s, sb_matrix *a)
{
    if (sb_matrix_create(s->nodes, s->cell_count, s->corners, NULL, s->cells, NULL, a, NULL) != SB_OK ||
        a->block_count != s->blocks)
        exit(1);
    memcpy(a->blocks, s->values, 9 * (size_t)s->blocks * sizeof(double));
    memcpy(a->fixed, s->fixed, (size_t)s->nodes);
}

static double least_setup(sb_preconditioner *p, const sb_matrix *a, const sb_vec3 *positions)
{
    double least = 1e30, begun = race_seconds();
    for (int k = 0; k < RACE_RUNS && (k == 0 || race_seconds() - begun < race_patience); k++) {
        double start = race_seconds();
        if (sb_preconditioner_update(p, a, positions, NULL) != SB_OK)
            return -1;
        least = fmin(least, race_seconds() - start);
    }
    return least;
}

static void run(const race_system *s, int solver, const sb_jobs *jobs)
{
    sb_preconditioner_def def = sb_default_preconditioner_def();
    sb_preconditioner *p = NULL;
    sb_pcg_options options = sb_default_pcg_options();
    sb_pcg_workspace workspace;
    sb_pcg_info info;
    sb_matrix a;
    double *x = (double *)race_take((size_t)s->n, sizeof(double)), setup;
    const sb_vec3 *positions = (const sb_vec3 *)(const void *)s->positions;
    make_matrix(s, &a);
    def.kind = solvers[solver].kind;
    def.positions = positions;
    def.poisson = (sb_real)s->poisson;
    def.jobs = *jobs;
    options.jobs = jobs;
    options.max_iterations = 5000;
    if (sb_preconditioner_create(&def, &a, NULL, &p, NULL) != SB_OK ||
        sb_pcg_workspace_create(s->nodes, NULL, &workspace, NULL) != SB_OK)
        exit(1);
    setup = least_setup(p, &a, positions);
    for (int t = 0; t < 2 && setup >= 0; t++) {
        double least = 1e30, begun = race_seconds();
        options.tolerance = race_tolerances[t];
        for (int k = 0; k < RACE_RUNS && (k == 0 || race_seconds() - begun < race_patience); k++) {
            double start = race_seconds();
            memset(x, 0, (size_t)s->n * sizeof(double));
            sb_pcg_solve(&a, p, s->rhs, x, &options, &workspace, &info);
            least = fmin(least, race_seconds() - start);
        }
        race_print(s, solvers[solver].name, race_threads(), race_tolerances[t], setup, least, info.iterations,
                   race_residual(s, x));
    }
    sb_pcg_workspace_free(&workspace);
    sb_preconditioner_free(p);
    sb_matrix_free(&a);
    free(x);
}

int main(int argc, char **argv)
{
    sb_jobs jobs = {NULL, NULL};
    const char *only = getenv("RACE_SOLVER");
#if defined(SB_USE_OPENMP)
    if (race_threads() > 1)
        jobs = sb_jobs_openmp();
#endif
    for (int k = 1; k < argc; k++) {
        race_system s;
        race_read(argv[k], &s);
        for (int solver = 0; solver < (int)(sizeof solvers / sizeof *solvers); solver++)
            if (s.n <= solvers[solver].most_unknowns && (!only || strcmp(only, solvers[solver].name) == 0))
                run(&s, solver, &jobs);
        race_free(&s);
    }
    return 0;
}
