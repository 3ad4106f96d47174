/* race_hypre: hypre's conjugate gradients with BoomerAMG in the race, one MPI process per thread. Arguments: files of
 * race_write. What serves elasticity best is not the same for every mesh, so each of the ways that its manual proposes
 * is tried, and printed with a name of its own: unknown approach (three functions) with several strength thresholds,
 * nodal coarsening, and interpolation that keeps rotations (Baker, Kolev and Yang 2010). Symmetric smoothers, HMIS
 * coarsening and extended+i interpolation throughout. */
#include <HYPRE.h>
#include <HYPRE_krylov.h>
#include <HYPRE_parcsr_ls.h>
#include <mpi.h>

#include "race.h"

/* Exported, but declared in internal headers only. */
HYPRE_Int HYPRE_BoomerAMGSetSmoothInterpVectors(HYPRE_Solver solver, HYPRE_Int smooth);
HYPRE_Int HYPRE_BoomerAMGSetInterpRefine(HYPRE_Solver solver, HYPRE_Int count);

typedef struct setting {
    const char *name;
    double threshold;
    int nodal, rotations, most_unknowns;
} setting;

static const setting settings[] = {{"hypre-unknown-25", 0.25, 0, 0, 60000},
                                   {"hypre-unknown-50", 0.5, 0, 0, 1000000},
                                   {"hypre-unknown-90", 0.9, 0, 0, 60000},
                                   {"hypre-nodal-50", 0.5, 1, 0, 60000},
                                   {"hypre-rotations", 0.5, 4, 1, 60000}};

/* This process's share of a system: rows first <= i < last. */
typedef struct share {
    int first, last;
    HYPRE_IJMatrix a;
    HYPRE_IJVector b, x, rotations[3];
} share;

static HYPRE_IJVector make_vector(int first, int last, const double *values)
{
    HYPRE_IJVector v;
    HYPRE_IJVectorCreate(MPI_COMM_WORLD, first, last - 1, &v);
    HYPRE_IJVectorSetObjectType(v, HYPRE_PARCSR);
    HYPRE_IJVectorInitialize(v);
    for (int i = first; i < last; i++)
        HYPRE_IJVectorSetValues(v, 1, &i, values ? values + i : &(double){0});
    HYPRE_IJVectorAssemble(v);
    return v;
}

static HYPRE_ParVector vector_of(HYPRE_IJVector v)
{
    void *object;
    HYPRE_IJVectorGetObject(v, &object);
    return (HYPRE_ParVector)object;
}

static HYPRE_ParCSRMatrix matrix_of(HYPRE_IJMatrix a)
{
    void *object;
    HYPRE_IJMatrixGetObject(a, &object);
    return (HYPRE_ParCSRMatrix)object;
}

static void make_share(const race_system *s, share *part)
{
    int rank, size;
    double *motion = (double *)race_take((size_t)s->n, sizeof(double));
    MPI_Comm_rank(MPI_COMM_WORLD, &rank);
    MPI_Comm_size(MPI_COMM_WORLD, &size);
    part->first = 3 * (int)((long)s->nodes * rank / size);
    part->last = 3 * (int)((long)s->nodes * (rank + 1) / size);
    HYPRE_IJMatrixCreate(MPI_COMM_WORLD, part->first, part->last - 1, part->first, part->last - 1, &part->a);
    HYPRE_IJMatrixSetObjectType(part->a, HYPRE_PARCSR);
    HYPRE_IJMatrixInitialize(part->a);
    for (int i = part->first; i < part->last; i++) {
        int count = s->start[i + 1] - s->start[i];
        HYPRE_IJMatrixSetValues(part->a, 1, &count, &i, s->column + s->start[i], s->value + s->start[i]);
    }
    HYPRE_IJMatrixAssemble(part->a);
    part->b = make_vector(part->first, part->last, s->rhs);
    part->x = make_vector(part->first, part->last, NULL);
    for (int axis = 0; axis < 3; axis++) {
        for (int i = 0; i < s->nodes; i++) {
            motion[3 * i + axis] = 0;
            motion[3 * i + (axis + 1) % 3] = -s->positions[3 * i + (axis + 2) % 3];
            motion[3 * i + (axis + 2) % 3] = s->positions[3 * i + (axis + 1) % 3];
        }
        part->rotations[axis] = make_vector(part->first, part->last, motion);
    }
    free(motion);
}

static void free_share(share *part)
{
    HYPRE_IJMatrixDestroy(part->a);
    HYPRE_IJVectorDestroy(part->b);
    HYPRE_IJVectorDestroy(part->x);
    for (int axis = 0; axis < 3; axis++)
        HYPRE_IJVectorDestroy(part->rotations[axis]);
}

static HYPRE_Solver make_amg(const setting *how, HYPRE_ParVector *rotations)
{
    HYPRE_Solver amg;
    HYPRE_BoomerAMGCreate(&amg);
    HYPRE_BoomerAMGSetTol(amg, 0);
    HYPRE_BoomerAMGSetMaxIter(amg, 1);
    HYPRE_BoomerAMGSetNumFunctions(amg, 3);
    HYPRE_BoomerAMGSetStrongThreshold(amg, how->threshold);
    HYPRE_BoomerAMGSetCoarsenType(amg, 10);
    HYPRE_BoomerAMGSetInterpType(amg, 6);
    HYPRE_BoomerAMGSetPMaxElmts(amg, 4);
    HYPRE_BoomerAMGSetRelaxType(amg, how->rotations ? 8 : 6);
    HYPRE_BoomerAMGSetNodal(amg, how->nodal);
    if (how->rotations) { /* as the MFEM library sets it up for elasticity */
        HYPRE_BoomerAMGSetNodalDiag(amg, 1);
        HYPRE_BoomerAMGSetRelaxOrder(amg, 0);
        HYPRE_BoomerAMGSetInterpVecVariant(amg, 2);
        HYPRE_BoomerAMGSetInterpVecQMax(amg, 4);
        HYPRE_BoomerAMGSetSmoothInterpVectors(amg, 1);
        HYPRE_BoomerAMGSetInterpRefine(amg, 1);
        HYPRE_BoomerAMGSetInterpVectors(amg, 3, rotations);
    }
    return amg;
}

static double least_of(double mine)
{
    double all;
    MPI_Allreduce(&mine, &all, 1, MPI_DOUBLE, MPI_MAX, MPI_COMM_WORLD); /* the slowest process counts */
    return all;
}

/* Gathers x on all processes and prints the line on the first. */
static void report(const race_system *s, const share *part, const setting *how, double tolerance, double setup,
                   double solve, int iterations)
{
    double *mine = (double *)calloc((size_t)s->n, sizeof(double));
    double *x = (double *)race_take((size_t)s->n, sizeof(double));
    int rank;
    for (int i = part->first; i < part->last; i++)
        HYPRE_IJVectorGetValues(part->x, 1, &i, mine + i);
    MPI_Allreduce(mine, x, s->n, MPI_DOUBLE, MPI_SUM, MPI_COMM_WORLD);
    MPI_Comm_rank(MPI_COMM_WORLD, &rank);
    if (rank == 0)
        race_print(s, how->name, race_threads(), tolerance, setup, solve, iterations, race_residual(s, x));
    free(mine);
    free(x);
}

static void run(const race_system *s, const share *part, const setting *how, double tolerance)
{
    HYPRE_ParVector b = vector_of(part->b), x = vector_of(part->x), rotations[3];
    HYPRE_ParCSRMatrix a = matrix_of(part->a);
    double setup = 1e30, solve = 1e30, begun = race_seconds();
    int iterations = 0;
    for (int axis = 0; axis < 3; axis++)
        rotations[axis] = vector_of(part->rotations[axis]);
    for (int k = 0; k < RACE_RUNS && (k == 0 || least_of(race_seconds() - begun) < race_patience); k++) {
        HYPRE_Solver pcg, amg = make_amg(how, rotations);
        double start, middle;
        HYPRE_ParCSRPCGCreate(MPI_COMM_WORLD, &pcg);
        HYPRE_PCGSetTol(pcg, tolerance);
        HYPRE_PCGSetMaxIter(pcg, 2000);
        HYPRE_PCGSetTwoNorm(pcg, 1);
        HYPRE_PCGSetPrecond(pcg, (HYPRE_PtrToSolverFcn)HYPRE_BoomerAMGSolve, (HYPRE_PtrToSolverFcn)HYPRE_BoomerAMGSetup,
                            amg);
        HYPRE_ParVectorSetConstantValues(x, 0);
        MPI_Barrier(MPI_COMM_WORLD);
        start = race_seconds();
        HYPRE_ParCSRPCGSetup(pcg, a, b, x);
        middle = race_seconds();
        HYPRE_ParCSRPCGSolve(pcg, a, b, x);
        solve = fmin(solve, least_of(race_seconds() - middle));
        setup = fmin(setup, least_of(middle - start));
        HYPRE_PCGGetNumIterations(pcg, &iterations);
        HYPRE_ParCSRPCGDestroy(pcg);
        HYPRE_BoomerAMGDestroy(amg);
        HYPRE_ClearAllErrors();
    }
    report(s, part, how, tolerance, setup, solve, iterations);
}

int main(int argc, char **argv)
{
    MPI_Init(&argc, &argv);
    HYPRE_Init();
    for (int k = 1; k < argc; k++) {
        race_system s;
        share part;
        race_read(argv[k], &s);
        make_share(&s, &part);
        for (int h = 0; h < (int)(sizeof settings / sizeof *settings); h++)
            for (int t = 0; t < 2 && s.n <= settings[h].most_unknowns; t++)
                run(&s, &part, settings + h, race_tolerances[t]);
        free_share(&part);
        race_free(&s);
    }
    HYPRE_Finalize();
    MPI_Finalize();
    return 0;
}
