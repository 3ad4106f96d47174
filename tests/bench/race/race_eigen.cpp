// race_eigen: Eigen's conjugate gradients in the race, with Jacobi's preconditioner and with an incomplete Cholesky
// factor. Arguments: files of race_write.
#include <Eigen/IterativeLinearSolvers>
#include <Eigen/SparseCore>

#include "race.h"

// Parallel products need all of the matrix, by rows.
typedef Eigen::SparseMatrix<double, Eigen::RowMajor> matrix;
typedef Eigen::ConjugateGradient<matrix, Eigen::Lower | Eigen::Upper, Eigen::DiagonalPreconditioner<double>> jacobi;
typedef Eigen::ConjugateGradient<matrix, Eigen::Lower | Eigen::Upper, Eigen::IncompleteCholesky<double>> incomplete;

template <typename solver> static void run(const race_system &s, const matrix &a, const char *name)
{
    Eigen::Map<const Eigen::VectorXd> b(s.rhs, s.n);
    for (int t = 0; t < 2; t++) {
        double setup = 1e30, solve = 1e30, begun = race_seconds();
        Eigen::VectorXd x;
        solver cg;
        cg.setTolerance(race_tolerances[t]);
        cg.setMaxIterations(20000);
        for (int k = 0; k < RACE_RUNS && (k == 0 || race_seconds() - begun < race_patience); k++) {
            double start = race_seconds();
            cg.compute(a);
            double middle = race_seconds();
            x = cg.solve(b);
            solve = std::min(solve, race_seconds() - middle);
            setup = std::min(setup, middle - start);
        }
        race_print(&s, name, race_threads(), race_tolerances[t], setup, solve, static_cast<int>(cg.iterations()),
                   race_residual(&s, x.data()));
    }
}

int main(int argc, char **argv)
{
    Eigen::setNbThreads(race_threads());
    for (int k = 1; k < argc; k++) {
        race_system s;
        race_read(argv[k], &s);
        Eigen::Map<const matrix> map(s.n, s.n, s.entries, s.start, s.column, s.value);
        matrix a(map);
        run<jacobi>(s, a, "eigen-jacobi");
        run<incomplete>(s, a, "eigen-ic");
        race_free(&s);
    }
    return 0;
}
