/* race_cholmod: CHOLMOD's supernodal Cholesky in the race: set-up is the numeric factorisation (analysis and ordering
 * are done before, once), solve the two triangular solves. Arguments: files of race_write. */
#include <suitesparse/cholmod.h>

#include "race.h"

enum { MOST_UNKNOWNS = 150000 }; /* beyond, the factor takes more memory than a common machine has */

/* Not half of all: of two entries that are equal but for rounding, one may be zero and left out. */
static size_t count_upper(const race_system *s)
{
    size_t count = 0;
    for (int j = 0; j < s->n; j++)
        for (int q = s->start[j]; q < s->start[j + 1]; q++)
            count += s->column[q] <= j;
    return count;
}

/* Upper triangle by columns: rows of a symmetric matrix are its columns. */
static cholmod_sparse *upper_triangle(const race_system *s, cholmod_common *c)
{
    size_t n = (size_t)s->n;
    cholmod_sparse *a = cholmod_l_allocate_sparse(n, n, count_upper(s), 1, 1, 1, CHOLMOD_REAL, c);
    SuiteSparse_long *p = (SuiteSparse_long *)a->p, *i = (SuiteSparse_long *)a->i, used = 0;
    for (int j = 0; j < s->n; j++) {
        p[j] = used;
        for (int q = s->start[j]; q < s->start[j + 1] && s->column[q] <= j; q++) {
            i[used] = s->column[q];
            ((double *)a->x)[used++] = s->value[q];
        }
    }
    p[s->n] = used;
    return a;
}

static void run(const race_system *s, cholmod_common *c)
{
    cholmod_sparse *a = upper_triangle(s, c);
    cholmod_dense *b = cholmod_l_zeros((size_t)s->n, 1, CHOLMOD_REAL, c), *x = NULL;
    double start = race_seconds(), setup = 1e30, solve = 1e30, begun;
    cholmod_factor *l = cholmod_l_analyze(a, c);
    printf("# cholmod %s: ordering and analysis %.0f ms, %.0f entries, %.3g operations\n", s->name,
           1e3 * (race_seconds() - start), c->lnz, c->fl);
    memcpy(b->x, s->rhs, (size_t)s->n * sizeof(double));
    begun = race_seconds();
    for (int k = 0; k < RACE_RUNS && (k == 0 || race_seconds() - begun < race_patience); k++) {
        double middle;
        start = race_seconds();
        cholmod_l_factorize(a, l, c);
        middle = race_seconds();
        cholmod_l_free_dense(&x, c);
        x = cholmod_l_solve(CHOLMOD_A, l, b, c);
        solve = fmin(solve, race_seconds() - middle);
        setup = fmin(setup, middle - start);
    }
    for (int t = 0; t < 2 && x; t++)
        race_print(s, "cholmod", race_threads(), race_tolerances[t], setup, solve, 1,
                   race_residual(s, (const double *)x->x));
    cholmod_l_free_factor(&l, c);
    cholmod_l_free_sparse(&a, c);
    cholmod_l_free_dense(&b, c);
    cholmod_l_free_dense(&x, c);
}

int main(int argc, char **argv)
{
    cholmod_common c;
    cholmod_l_start(&c);
    c.supernodal = CHOLMOD_SUPERNODAL;
    for (int k = 1; k < argc; k++) {
        race_system s;
        race_read(argv[k], &s);
        if (s.n <= MOST_UNKNOWNS)
            run(&s, &c);
        race_free(&s);
    }
    cholmod_l_finish(&c);
    return 0;
}
