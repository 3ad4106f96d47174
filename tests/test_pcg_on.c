/* Tests of solves that go on from the last one, whose matrix and forces have changed in a few rows: they reach what a
 * solve from its start does, in as many iterations and without the product that those begin with. They are internal. */
#define SB_SPLIT_BUILD
#include "../src/softbody/solve/pcg.h"

#include "check.h"
#include "scene.h"
#include "tet_beam.h"

enum { TOUCHED = 12, ROUNDS = 6, KINDS = 5 };

static const sb_precond_kind kinds[KINDS] = {SB_PRECOND_IC0, SB_PRECOND_BLOCK_JACOBI, SB_PRECOND_FSAI, SB_PRECOND_SSOR,
                                             SB_PRECOND_CHOLESKY};

typedef struct on_case {
    beam b;
    sb_preconditioner *precond;
    sb_pcg_workspace workspace;
    int touched[TOUCHED];
    sb_real springs[TOUCHED]; /* N/m */
} on_case;

static on_case on_make(sb_precond_kind kind, double mass_factor)
{
    on_case c;
    sb_preconditioner_def def;
    memset(&c, 0, sizeof c);
    def = sb_default_preconditioner_def();
    c.b = beam_make(8, 4, 4, mass_factor, 1);
    def.kind = kind;
    def.positions = c.b.positions;
    CHECK_OK(sb_preconditioner_create(&def, &c.b.a, NULL, &c.precond, NULL));
    CHECK_OK(sb_preconditioner_update(c.precond, &c.b.a, NULL, NULL));
    CHECK_OK(sb_pcg_workspace_create(c.b.nodes, NULL, &c.workspace, NULL));
    return c;
}

static void on_free(on_case *c)
{
    sb_preconditioner_free(c->precond);
    sb_pcg_workspace_free(&c->workspace);
    beam_free(&c->b);
}

/* The residual in the workspace is that of x. */
static sb_result on_solve(const sb_matrix *a, sb_preconditioner *precond, const sb_real *rhs, sb_real *x,
                          const sb_pcg_options *options, sb_pcg_workspace *workspace, sb_pcg_info *info)
{
    sbi_pcg_demand demand;
    memset(&demand, 0, sizeof demand);
    demand.goes_on = 1;
    return sbi_pcg_solve_guests(a, precond, rhs, x, NULL, options, workspace, &demand, info);
}

/* |rhs - A x| and |rhs|, in double. */
static double on_residual(const beam *b, const sb_real *x, double *size)
{
    double left = 0, whole = 0;
    for (int i = 0; i < b->nodes; i++)
        for (int r = 0; r < 3; r++) {
            double rhs = (double)b->rhs[3 * i + r], value = rhs;
            for (int q = b->a.row_start[i]; q < b->a.row_start[i + 1]; q++)
                for (int k = 0; k < 3; k++)
                    value -= (double)b->a.blocks[q][3 * r + k] * (double)x[3 * b->a.columns[q] + k];
            left += value * value;
            whole += rhs * rhs;
        }
    *size = sqrt(whole);
    return sqrt(left);
}

/* A node's spring changes. */
static void on_spring(on_case *c, int node, sb_real change)
{
    sb_real *block = c->b.a.blocks[c->b.a.diagonal[node]];
    for (size_t r = 0; r < 3 && !c->b.mask[node]; r++) {
        block[4 * r] += change;
        c->workspace.residual[3 * (size_t)node + r] -= change * c->b.x[3 * (size_t)node + r];
    }
}

/* Some nodes get springs, which others had before, and forces of up to `push` times the mean force; the residual of x
 * follows. */
static void on_touch(on_case *c, double push, unsigned long long *seed)
{
    double size, mean;
    (void)on_residual(&c->b, c->b.x, &size);
    mean = size / sqrt((double)c->b.nodes);
    for (int k = 0; k < TOUCHED; k++) {
        int node = (int)check_random_in(seed, 0, c->b.nodes - 1e-3);
        on_spring(c, c->touched[k], -c->springs[k]);
        c->touched[k] = node;
        c->springs[k] = REAL(check_random_in(seed, 0, 0.5) * (double)c->b.a.blocks[c->b.a.diagonal[node]][0]);
        on_spring(c, node, c->springs[k]);
        for (size_t r = 0; r < 3 && !c->b.mask[node]; r++) {
            sb_real force = REAL(mean * check_random_in(seed, -push, push));
            c->b.rhs[3 * (size_t)node + r] += force;
            c->workspace.residual[3 * (size_t)node + r] += force;
        }
    }
}

/* The same system from the same x, by a solve of its own. */
static int on_anew(const on_case *c, const sb_real *start, const sb_pcg_options *options)
{
    sb_real *x = (sb_real *)malloc(3 * (size_t)c->b.nodes * sizeof(sb_real));
    sb_pcg_workspace workspace;
    sb_pcg_info info;
    memcpy(x, start, 3 * (size_t)c->b.nodes * sizeof(sb_real));
    CHECK_OK(sb_pcg_workspace_create(c->b.nodes, NULL, &workspace, NULL));
    CHECK_OK(sb_pcg_solve(&c->b.a, c->precond, c->b.rhs, x, options, &workspace, &info));
    sb_pcg_workspace_free(&workspace);
    free(x);
    return info.iterations;
}

/* All free nodes get the same force: the coarse space has most of it. */
static void on_lean(on_case *c, double push)
{
    double size, mean;
    (void)on_residual(&c->b, c->b.x, &size);
    mean = size / sqrt((double)c->b.nodes);
    for (int i = 0; i < c->b.nodes; i++)
        for (size_t r = 0; r < 3 && !c->b.mask[i]; r++) {
            c->b.rhs[3 * (size_t)i + r] += REAL(push * mean);
            c->workspace.residual[3 * (size_t)i + r] += REAL(push * mean);
        }
}

typedef struct on_counts {
    int own, anew; /* iterations */
} on_counts;

/* push < 0: all nodes are pushed. */
static void check_on(on_case *c, double tolerance, double push, on_counts *counts)
{
    const double slack = SB_REAL_IS_FLOAT ? 0.3 : 0.01; /* single precision holds some 1e-4 of the forces */
    sb_pcg_options options = sb_default_pcg_options();
    unsigned long long seed = 11;
    options.tolerance = tolerance;
    CHECK_OK(sb_pcg_solve(&c->b.a, c->precond, c->b.rhs, c->b.x, &options, &c->workspace, NULL));
    for (int round = 0; round < ROUNDS; round++) {
        double size, left;
        sb_pcg_info info;
        CHECK(c->workspace.record->is_left);
        if (push < 0)
            on_lean(c, -push);
        else
            on_touch(c, push, &seed);
        counts->anew += on_anew(c, c->b.x, &options);
        CHECK_OK(on_solve(&c->b.a, c->precond, c->b.rhs, c->b.x, &options, &c->workspace, &info));
        counts->own += info.iterations;
        left = on_residual(&c->b, c->b.x, &size);
        CHECK(left <= (1 + slack) * tolerance * size);
        CHECK_NEAR(info.residual * size, left, slack * tolerance * size);
    }
}

static void check_pushes_of(sb_precond_kind kind, double push)
{
    const double fine = SB_REAL_IS_FLOAT ? 1e-3 : 1e-7;
    on_counts counts = {0, 0};
    for (int k = 0; k < 4; k++) {
        on_case c = on_make(kind, k % 2);
        CHECK(!c.workspace.record->is_left);
        check_on(&c, k < 2 ? 1e-2 : fine, push, &counts);
        on_free(&c);
    }
    if (getenv("CHECK_SLOW"))
        printf("    pushes of %.1f, kind %d: %d iterations, anew %d\n", push, (int)kind, counts.own, counts.anew);
    CHECK(counts.own <= 1.02 * counts.anew + 2);
}

static void check_pushes(double push)
{
    for (int k = 0; k < KINDS; k++)
        check_pushes_of(kinds[k], push);
}

static void test_pushes(void)
{
    check_pushes(0.3);
    check_pushes(3);
}

static void test_leaning(void)
{
    check_pushes(-0.5);
    check_pushes(-30);
}

/* Only what was solved, and without guests, can be gone on from. */
static void test_may_go_on(void)
{
    on_case c = on_make(SB_PRECOND_IC0, 1);
    sb_pcg_options options = sb_default_pcg_options();
    sb_pcg_info info;
    options.tolerance = 1e-4;
    options.max_iterations = 1;
    CHECK_RESULT(sb_pcg_solve(&c.b.a, c.precond, c.b.rhs, c.b.x, &options, &c.workspace, NULL), SB_ERROR_NOT_CONVERGED);
    CHECK(!c.workspace.record->is_left);
    options.max_iterations = 1000;
    CHECK_OK(sb_pcg_solve(&c.b.a, c.precond, c.b.rhs, c.b.x, &options, &c.workspace, NULL));
    CHECK(c.workspace.record->is_left);
    check_bad_numbers();
    c.workspace.residual[3 * (size_t)c.b.nodes - 1] = (sb_real)HUGE_VAL;
    CHECK_RESULT(on_solve(&c.b.a, c.precond, c.b.rhs, c.b.x, &options, &c.workspace, &info), SB_ERROR_DIVERGED);
    CHECK(!c.workspace.record->is_left);
    CHECK_RESULT(on_solve(NULL, c.precond, c.b.rhs, c.b.x, &options, &c.workspace, &info), SB_ERROR_ARGUMENT);
    on_free(&c);
}

/* Two tetrahedra that share no node, each on springs; the second alone, pushed, lies still again in the next system. */
static void check_rest(const sb_precond_kind *kind)
{
    static const int cells[8] = {0, 1, 2, 3, 4, 5, 6, 7};
    sb_vec3 at[8];
    sb_real x[24], rhs[24];
    sb_matrix a;
    sb_preconditioner *precond = NULL;
    sb_pcg_workspace workspace;
    sb_pcg_options options = sb_default_pcg_options();
    CHECK_OK(sb_matrix_create(8, 2, 4, NULL, cells, NULL, &a, NULL));
    memset(x, 0, sizeof x);
    memset(rhs, 0, sizeof rhs);
    for (int i = 0; i < 8; i++)
        at[i] = sb_v3(REAL(i / 4 + (i % 4 == 1)), REAL(i % 4 == 2), REAL(i % 4 == 3));
    for (int e = 0; e < 2; e++)
        beam_add_tet(&a, at, cells + 4 * e, 1, 1, 1, 1, rhs);
    if (kind) {
        sb_preconditioner_def def = sb_default_preconditioner_def();
        def.kind = *kind;
        def.positions = at;
        CHECK_OK(sb_preconditioner_create(&def, &a, NULL, &precond, NULL));
        CHECK_OK(sb_preconditioner_update(precond, &a, NULL, NULL));
    }
    CHECK_OK(sb_pcg_workspace_create(8, NULL, &workspace, NULL));
    CHECK_OK(sb_pcg_solve(&a, precond, rhs, x, &options, &workspace, NULL));
    CHECK(x[14] < 0 && workspace.record->is_left);
    for (int k = 12; k < 24; k++) {
        workspace.residual[k] -= rhs[k];
        rhs[k] = 0;
    }
    CHECK_OK(on_solve(&a, precond, rhs, x, &options, &workspace, NULL));
    CHECK(x[2] < 0);
    for (int k = 12; k < 24; k++)
        CHECK(x[k] == 0 && workspace.residual[k] == 0);
    sb_preconditioner_free(precond);
    sb_pcg_workspace_free(&workspace);
    sb_matrix_free(&a);
}

static void test_rest(void)
{
    for (int k = 0; k < KINDS; k++)
        check_rest(kinds + k);
    check_rest(NULL);
}

/* ---- better starts ----------------------------------------------------------------------------------------------- */

/* The solution of the beam's system, the start and the bend are sums of it and of anything. */
static void bend_mix(const on_case *c, const sb_real *solution, double share, unsigned long long *seed, sb_real *start,
                     sb_real *bend)
{
    double size = 0;
    for (int k = 0; k < c->b.n; k++)
        size = fmax(size, fabs((double)solution[k]));
    for (int k = 0; k < c->b.n; k++) {
        double smooth = 0.1 * (double)(&c->b.positions[k / 3].x)[k % 3], rough = check_random_in(seed, -1, 1);
        double other =
            size * (SB_REAL_IS_FLOAT ? smooth : rough); /* forces of rough ones are beyond single precision */
        int held = c->b.mask[k / 3] >> (k % 3) & 1;
        start[k] = held ? solution[k] : REAL(share * (double)solution[k] + other);
        bend[k] = REAL(-2 * (double)solution[k] + 3 * other); /* counts for nothing where motion is prescribed */
    }
}

static sb_pcg_info bend_solve(on_case *c, const sb_real *start, const sb_real *bend, double tolerance)
{
    sb_pcg_options options = sb_default_pcg_options();
    sbi_pcg_demand demand = sbi_pcg_step_demand();
    sb_pcg_info info;
    options.tolerance = tolerance;
    demand.bend = bend;
    memcpy(c->b.x, start, (size_t)c->b.n * sizeof(sb_real));
    CHECK_OK(
        sbi_pcg_solve_guests(&c->b.a, c->precond, c->b.rhs, c->b.x, NULL, &options, &c->workspace, &demand, &info));
    return info;
}

/* What start and bend span holds the solution: it is found at once, from wherever, and confirmed by one iteration. */
static void test_bend_finds(void)
{
    const double fine = SB_REAL_IS_FLOAT ? 1e-2 : 1e-9;
    unsigned long long seed = 5;
    for (int k = 0; k < KINDS; k++) {
        on_case c = on_make(kinds[k], 1);
        size_t bytes = (size_t)c.b.n * sizeof(sb_real);
        sb_real *solution = (sb_real *)malloc(bytes), *start = (sb_real *)malloc(bytes),
                *bend = (sb_real *)malloc(bytes);
        double size;
        memset(start, 0, bytes);
        (void)bend_solve(&c, start, NULL, SB_REAL_IS_FLOAT ? 1e-3 : 1e-12);
        memcpy(solution, c.b.x, bytes);
        for (int trial = 0; trial < 6; trial++) {
            bend_mix(&c, solution, trial - 2, &seed, start, bend);
            CHECK(kinds[k] == SB_PRECOND_CHOLESKY || bend_solve(&c, start, NULL, fine).iterations > 3);
            CHECK_INT(bend_solve(&c, start, bend, fine).iterations, 1);
            CHECK(on_residual(&c.b, c.b.x, &size) <= 2 * fine * size);
        }
        free(solution);
        free(start);
        free(bend);
        on_free(&c);
    }
}

/* Any bend, none, and ones next to nothing: the same solution, to the tolerance. */
static void test_bend_any(void)
{
    const double tolerance = SB_REAL_IS_FLOAT ? 1e-3 : 1e-6;
    unsigned long long seed = 9;
    on_case c = on_make(SB_PRECOND_IC0, 1);
    size_t bytes = (size_t)c.b.n * sizeof(sb_real);
    sb_real *start = (sb_real *)malloc(bytes), *bend = (sb_real *)malloc(bytes), *plain = (sb_real *)malloc(bytes);
    for (int k = 0; k < c.b.n; k++)
        start[k] = c.b.mask[k / 3] ? 0 : REAL(check_random_in(&seed, -1e-3, 1e-3));
    (void)bend_solve(&c, start, NULL, tolerance);
    memcpy(plain, c.b.x, bytes);
    for (int kind = 0; kind < 5; kind++) {
        const double sizes[5] = {0, SB_REAL_IS_FLOAT ? 1e-44 : 1e-160, 1e-30, 1, 1e18};
        double size;
        for (int k = 0; k < c.b.n; k++)
            bend[k] = REAL(sizes[kind] * check_random_in(&seed, -1, 1));
        (void)bend_solve(&c, start, bend, tolerance);
        CHECK(on_residual(&c.b, c.b.x, &size) <=
              1.01 * tolerance * size + (SB_REAL_IS_FLOAT ? 0.3 * tolerance * size : 0));
        for (int k = 0; k < c.b.n; k++)
            if (c.b.mask[k / 3])
                CHECK(c.b.x[k] == plain[k]);
    }
    free(start);
    free(bend);
    free(plain);
    on_free(&c);
}

/* Two tetrahedra, the solution of each of which is another sum: parts have shares of their own. */
static void test_bend_parts(void)
{
    static const int cells[8] = {0, 1, 2, 3, 4, 5, 6, 7};
    sb_vec3 at[8];
    sb_real x[24], rhs[24], bend[24];
    sb_matrix a;
    sb_pcg_workspace workspace;
    sb_pcg_info info;
    sb_pcg_options options = sb_default_pcg_options();
    sbi_pcg_demand demand = sbi_pcg_step_demand();
    CHECK_OK(sb_matrix_create(8, 2, 4, NULL, cells, NULL, &a, NULL));
    for (int i = 0; i < 8; i++)
        at[i] = sb_v3(REAL(i / 4 + (i % 4 == 1)), REAL(i % 4 == 2), REAL(i % 4 == 3));
    memset(rhs, 0, sizeof rhs);
    for (int e = 0; e < 2; e++)
        beam_add_tet(&a, at, cells + 4 * e, 1, 1, 1, 1, rhs);
    for (int k = 0; k < 24; k++) {
        x[k] = REAL(1 + k % 5);
        bend[k] = REAL(k % 7 - 3);
    }
    sb_matrix_multiply(&a, x, rhs, NULL);
    for (int k = 0; k < 24; k++) { /* 1.5 start - 2 bend, and -3 start + bend / 4 */
        sb_real was = x[k];
        x[k] = k < 12 ? (was + 2 * bend[k]) / (sb_real)1.5 : (was - bend[k] / 4) / -3;
    }
    CHECK_OK(sb_pcg_workspace_create(8, NULL, &workspace, NULL));
    demand.bend = bend;
    options.tolerance = SB_REAL_IS_FLOAT ? 1e-4 : 1e-9;
    CHECK_OK(sbi_pcg_solve_guests(&a, NULL, rhs, x, NULL, &options, &workspace, &demand, &info));
    CHECK_INT(info.iterations, 1);
    for (int k = 0; k < 24; k++)
        CHECK_NEAR(x[k], 1 + k % 5, SB_REAL_IS_FLOAT ? 1e-3 : 1e-8);
    sb_pcg_workspace_free(&workspace);
    sb_matrix_free(&a);
}

CHECK_SUITE(pcg_on, {"better starts", test_bend_finds}, {"any bend", test_bend_any},
            {"bends by parts", test_bend_parts}, {"pushes in a few rows", test_pushes},
            {"pushes everywhere", test_leaning}, {"what can be gone on from", test_may_go_on},
            {"a part that comes to rest", test_rest});
