/* Tests of sparse: patterns of known meshes, products against dense ones, constraints against reduced
 * systems, bad input and failing allocations. */
#include "softbody.h"

#include "check.h"

/* ---- helpers ---- */

/* Structured tetrahedra, six per cube; returns cells [6 nx ny nz][4], to be freed. */
static int *grid_cells(int nx, int ny, int nz)
{
    static const int paths[6][3] = {{0, 1, 2}, {0, 2, 1}, {1, 0, 2}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}};
    int *cells = (int *)malloc(sizeof(int) * 24 * (size_t)(nx * ny * nz)), *out = cells;
    for (int cube = 0; cube < nx * ny * nz; cube++)
        for (int path = 0; path < 6; path++) {
            int at[3] = {cube / (ny * nz), cube / nz % ny, cube % nz};
            for (int v = 0; v < 4; v++) {
                *out++ = (at[0] * (ny + 1) + at[1]) * (nz + 1) + at[2];
                at[v < 3 ? paths[path][v] : 0]++;
            }
        }
    return cells;
}

static sb_matrix make(int nodes, int cells, int per_cell, const int *list)
{
    sb_matrix matrix;
    memset(&matrix, 0, sizeof matrix);
    CHECK_OK(sb_matrix_create(nodes, cells, per_cell, NULL, list, NULL, &matrix, NULL));
    return matrix;
}

/* Random symmetric values with a strong diagonal: positive definite. */
static void fill_random(sb_matrix *a, unsigned long long seed)
{
    for (int i = 0; i < a->row_count; i++)
        for (int q = a->row_start[i]; q < a->row_start[i + 1]; q++)
            for (int r = 0; r < 3 && a->columns[q] <= i; r++)
                for (int c = 0; c < 3; c++) {
                    sb_real value = (sb_real)check_random_in(&seed, -1, 1);
                    a->blocks[q][3 * r + c] = value;
                    a->blocks[a->transpose[q]][3 * c + r] = value;
                }
    for (int i = 0; i < a->row_count; i++)
        for (int r = 0; r < 3; r++)
            a->blocks[a->diagonal[i]][4 * r] += (sb_real)(3 * (a->row_start[i + 1] - a->row_start[i]));
}

static double *dense_of(const sb_matrix *a)
{
    size_t n = 3 * (size_t)a->row_count;
    double *dense = (double *)calloc(n * n, sizeof(double));
    for (int i = 0; i < a->row_count; i++)
        for (int q = a->row_start[i]; q < a->row_start[i + 1]; q++)
            for (int k = 0; k < 9; k++)
                dense[(3 * (size_t)i + (size_t)(k / 3)) * n + 3 * (size_t)a->columns[q] + (size_t)(k % 3)] =
                    (double)a->blocks[q][k];
    return dense;
}

/* Gaussian elimination with the system's rows chosen by free[]; x keeps its other entries, which are
 * known. */
static void dense_solve(const double *dense, const double *rhs, const int *is_free, double *x, int n)
{
    double *m = (double *)calloc((size_t)(n * (n + 1)), sizeof(double));
    int *map = (int *)calloc((size_t)n, sizeof(int)), count = 0;
    for (int i = 0; i < n; i++)
        if (is_free[i])
            map[count++] = i;
    for (int i = 0; i < count; i++) {
        m[i * (n + 1) + count] = rhs[map[i]];
        for (int j = 0; j < n; j++)
            if (!is_free[j])
                m[i * (n + 1) + count] -= dense[map[i] * n + j] * x[j];
        for (int j = 0; j < count; j++)
            m[i * (n + 1) + j] = dense[map[i] * n + map[j]];
    }
    for (int k = 0; k < count; k++)
        for (int i = 0; i < count; i++)
            for (int j = count; i != k && j >= k; j--)
                m[i * (n + 1) + j] -= m[i * (n + 1) + k] / m[k * (n + 1) + k] * m[k * (n + 1) + j];
    for (int k = 0; k < count; k++)
        x[map[k]] = m[k * (n + 1) + count] / m[k * (n + 1) + k];
    free(m);
    free(map);
}

/* A job system with several threads' worth of disorder: tasks dealt to `threads` hands, hands served
 * backwards. */
static void scrambled_run(void *user, sb_task task, void *task_user, int count)
{
    int threads = *(const int *)user;
    for (int hand = threads; hand-- > 0;)
        for (int i = count; i-- > 0;)
            if (i % threads == hand)
                task(task_user, i);
}

/* Allocator that fails at its n-th call and counts what is out. */
typedef struct failing_memory {
    int calls, fail_at, live;
} failing_memory;

static void *failing_alloc(void *user, size_t bytes)
{
    failing_memory *memory = (failing_memory *)user;
    if (memory->calls++ == memory->fail_at)
        return NULL;
    memory->live++;
    return malloc(bytes);
}

static void failing_release(void *user, void *pointer)
{
    ((failing_memory *)user)->live--;
    free(pointer);
}

static sb_allocator failing_allocator(failing_memory *memory)
{
    sb_allocator allocator;
    allocator.alloc = failing_alloc;
    allocator.release = failing_release;
    allocator.user = memory;
    return allocator;
}

/* ---- patterns ---- */

static void check_pattern(const sb_matrix *a)
{
    CHECK_INT(a->row_start[0], 0);
    CHECK_INT(a->row_start[a->row_count], a->block_count);
    CHECK_INT((uintptr_t)a->blocks % 64, 0);
    for (int i = 0; i < a->row_count; i++) {
        CHECK_INT(a->columns[a->diagonal[i]], i);
        for (int q = a->row_start[i]; q < a->row_start[i + 1]; q++) {
            int j = a->columns[q], t = a->transpose[q];
            CHECK(q == a->row_start[i] || a->columns[q - 1] < j);
            CHECK(t >= a->row_start[j] && t < a->row_start[j + 1] && a->columns[t] == i);
            CHECK_INT(sb_matrix_find(a, i, j), q);
        }
    }
}

static void test_pattern_of_two_tets(void)
{
    /* nodes 1 2 3 shared; node 5 in no cell */
    static const int cells[8] = {4, 2, 1, 3, 0, 1, 3, 2};
    static const int expected[6][6] = {{1, 1, 1, 1, 0, 0}, {1, 1, 1, 1, 1, 0}, {1, 1, 1, 1, 1, 0},
                                       {1, 1, 1, 1, 1, 0}, {0, 1, 1, 1, 1, 0}, {0, 0, 0, 0, 0, 1}};
    sb_matrix a = make(6, 2, 4, cells);
    check_pattern(&a);
    CHECK_INT(a.block_count, 24);
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < 6; j++)
            CHECK_INT(sb_matrix_find(&a, i, j) >= 0, expected[i][j]);
    CHECK_INT(sb_matrix_find(&a, -1, 0), -1);
    CHECK_INT(sb_matrix_find(&a, 0, 6), -1);
    for (int q = 0; q < a.block_count; q++)
        for (int k = 0; k < 9; k++)
            CHECK(a.blocks[q][k] == 0);
    sb_matrix_free(&a);
    CHECK(a.memory == NULL && a.row_count == 0);
    sb_matrix_free(&a);
}

/* Each node of such a grid is joined to its 7 neighbours with steps of 0 or 1, and they to it. */
static void test_pattern_of_grid(void)
{
    int nx = 5, ny = 4, nz = 3, edges = 0, *cells = grid_cells(nx, ny, nz);
    sb_matrix a = make((nx + 1) * (ny + 1) * (nz + 1), 6 * nx * ny * nz, 4, cells);
    for (int k = 1; k < 8; k++)
        edges += (nx + 1 - (k & 1)) * (ny + 1 - (k >> 1 & 1)) * (nz + 1 - (k >> 2));
    check_pattern(&a);
    CHECK_INT(a.block_count, a.row_count + 2 * edges);
    sb_matrix_free(&a);
    free(cells);
}

static void test_lists_equal_fixed_cells(void)
{
    int *cells = grid_cells(2, 2, 2), start[49];
    sb_matrix a = make(27, 48, 4, cells), b;
    memset(&b, 0, sizeof b);
    for (int c = 0; c < 49; c++)
        start[c] = 4 * c;
    CHECK_OK(sb_matrix_create(27, 48, -7, start, cells, NULL, &b, NULL));
    CHECK_INT(b.block_count, a.block_count);
    CHECK(memcmp(a.row_start, b.row_start, sizeof(int) * 28) == 0);
    CHECK(memcmp(a.columns, b.columns, sizeof(int) * (size_t)a.block_count) == 0);
    CHECK(memcmp(a.transpose, b.transpose, sizeof(int) * (size_t)a.block_count) == 0);
    sb_matrix_free(&a);
    sb_matrix_free(&b);
    free(cells);
}

static void test_lists_of_any_length(void)
{
    static const int start[5] = {0, 0, 1, 6, 8}, cells[8] = {3, 0, 2, 0, 4, 2, 1, 4};
    sb_matrix a;
    memset(&a, 0, sizeof a);
    if (!CHECK_OK(sb_matrix_create(5, 4, 0, start, cells, NULL, &a, NULL)))
        return;
    check_pattern(&a);
    CHECK_INT(a.block_count, 5 + 2 * (3 + 1)); /* 0-2 0-4 2-4, 1-4; node 3 alone, 0 and 2 repeated */
    sb_matrix_free(&a);
    CHECK_OK(sb_matrix_create(3, 0, 4, NULL, NULL, NULL, &a, NULL));
    CHECK_INT(a.block_count, 3);
    sb_matrix_free(&a);
}

/* ---- products ---- */

static void check_product(sb_matrix *a)
{
    int n = 3 * a->row_count;
    unsigned long long seed = 3;
    double *dense;
    sb_real *x = (sb_real *)malloc(sizeof(sb_real) * (size_t)n), *y = (sb_real *)malloc(sizeof(sb_real) * (size_t)n);
    fill_random(a, 11);
    dense = dense_of(a);
    for (int i = 0; i < n; i++)
        x[i] = (sb_real)check_random_in(&seed, -1, 1);
    sb_matrix_multiply(a, x, y, NULL);
    for (int i = 0; i < n; i++) {
        double sum = 0, size = 0;
        for (int j = 0; j < n; j++) {
            sum += dense[i * n + j] * (double)x[j];
            size += fabs(dense[i * n + j] * (double)x[j]);
        }
        CHECK_NEAR(y[i], sum, 8 * (double)SB_EPSILON * size);
    }
    CHECK(sb_matrix_asymmetry(a) == 0);
    free(x);
    free(y);
    free(dense);
}

static void test_product_equals_dense(void)
{
    static const int tet[4] = {0, 1, 2, 3};
    int *cells = grid_cells(3, 2, 2);
    sb_matrix a = make(36, 72, 4, cells), one = make(1, 0, 4, NULL), four = make(4, 1, 4, tet);
    check_product(&a);
    check_product(&one);
    check_product(&four);
    sb_matrix_free(&a);
    sb_matrix_free(&one);
    sb_matrix_free(&four);
    free(cells);
}

static void test_product_on_threads(void)
{
    static const int threads[4] = {1, 2, 3, 7};
    int *cells = grid_cells(17, 10, 10), n = 3 * 18 * 11 * 11;
    sb_matrix a = make(n / 3, 6 * 1700, 4, cells);
    size_t bytes = sizeof(sb_real) * (size_t)n;
    sb_real *x = (sb_real *)malloc(bytes), *y = (sb_real *)malloc(bytes), *z = (sb_real *)malloc(bytes);
    fill_random(&a, 5);
    for (int i = 0; i < n; i++)
        x[i] = (sb_real)(i % 17 - 8);
    sb_matrix_multiply(&a, x, y, NULL);
    for (int k = 0; k < 4; k++) {
        int count = threads[k];
        sb_jobs jobs;
        jobs.run = scrambled_run;
        jobs.user = &count;
        memset(z, 0, bytes);
        sb_matrix_multiply(&a, x, z, &jobs);
        CHECK(memcmp(y, z, bytes) == 0);
    }
    free(x);
    free(y);
    free(z);
    free(cells);
    sb_matrix_free(&a);
}

static void test_asymmetry(void)
{
    static const int pair[2] = {0, 1};
    sb_matrix a = make(2, 1, 2, pair);
    CHECK(sb_matrix_asymmetry(&a) == 0);
    a.blocks[a.diagonal[0]][0] = 4;
    a.blocks[sb_matrix_find(&a, 0, 1)][1] = 2;
    CHECK_NEAR(sb_matrix_asymmetry(&a), 0.5, 0);
    a.blocks[sb_matrix_find(&a, 1, 0)][3] = 1;
    CHECK_NEAR(sb_matrix_asymmetry(&a), 0.25, 0);
    a.blocks[a.diagonal[1]][2] = (sb_real)NAN;
    check_bad_numbers();
    CHECK(isnan((double)sb_matrix_asymmetry(&a)));
    a.fixed[1] = SB_XYZ;
    sb_matrix_clear(&a);
    CHECK(sb_matrix_asymmetry(&a) == 0 && a.fixed[1] == 0 && a.blocks[a.diagonal[0]][0] == 0);
    sb_matrix_free(&a);
}

/* ---- constraints ---- */

/* The constrained system has the free unknowns of the reduced one and the prescribed values. */
static void check_constrained(const sb_real *values, int with_rhs)
{
    enum { NODES = 18, N = 54 };
    int *cells = grid_cells(2, 2, 1), is_free[N], all[N];
    sb_matrix a = make(NODES, 24, 4, cells);
    unsigned char mask[NODES] = {0};
    unsigned long long seed = 21;
    double *before, *after, expected[N], found[N], rhs[N], new_rhs[N], scale = 0;
    sb_real b[N];
    int count = 0;
    fill_random(&a, 31);
    before = dense_of(&a);
    mask[0] = SB_XYZ;
    mask[4] = SB_Y;
    mask[9] = SB_X | SB_Z;
    mask[17] = SB_XYZ;
    for (int i = 0; i < N; i++) {
        b[i] = (sb_real)check_random_in(&seed, -1, 1);
        rhs[i] = (double)b[i];
        is_free[i] = !(mask[i / 3] >> (i % 3) & 1);
        all[i] = 1;
        expected[i] = values ? (double)values[i] : 0;
        found[i] = 0;
        scale += is_free[i] ? fabs(before[i * N + i]) : 0;
        count += is_free[i];
    }
    dense_solve(before, rhs, is_free, expected, N);
    CHECK_NEAR(sb_matrix_diagonal_scale(&a, mask), scale / count, 10 * (double)SB_EPSILON * scale / count);
    sb_matrix_constrain(&a, mask, values, with_rhs ? b : NULL);
    CHECK(sb_matrix_asymmetry(&a) == 0);
    CHECK(memcmp(a.fixed, mask, NODES) == 0);
    after = dense_of(&a);
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) {
            double entry = is_free[i] && is_free[j] ? before[i * N + j] : i == j ? scale / count : 0;
            CHECK_NEAR(after[i * N + j], entry, 10 * (double)SB_EPSILON * fabs(entry));
        }
    for (int i = 0; i < N; i++)
        new_rhs[i] = (double)b[i];
    dense_solve(after, new_rhs, all, found, N);
    for (int i = 0; with_rhs && i < N; i++)
        CHECK_NEAR(found[i], expected[i], 100 * (double)SB_EPSILON);
    for (int i = 0; !with_rhs && i < N; i++)
        CHECK(new_rhs[i] == rhs[i]);
    sb_matrix_free(&a);
    free(cells);
    free(before);
    free(after);
}

static void test_constrain(void)
{
    sb_real values[54];
    for (int i = 0; i < 54; i++)
        values[i] = (sb_real)(0.25 * (i % 7) - 1);
    check_constrained(values, 1);
    check_constrained(NULL, 1);
    check_constrained(values, 0);
}

static void test_constrain_extremes(void)
{
    static const int tet[4] = {0, 1, 2, 3};
    static const unsigned char none[4] = {0, 0, 0, 0}, all[4] = {7, 7, 7, 7}, high[4] = {0xf8, 0, 0, 0};
    sb_matrix a = make(4, 1, 4, tet);
    sb_real rhs[12] = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12}, values[12] = {3, 1, 4, 1, 5, 9, 2, 6, 5, 3, 5, 8};
    CHECK(sb_matrix_diagonal_scale(&a, NULL) == 1); /* all zero */
    fill_random(&a, 1);
    double *before = dense_of(&a), *after;
    sb_matrix_constrain(&a, none, values, rhs);
    sb_matrix_constrain(&a, high, values, rhs); /* bits without a meaning */
    after = dense_of(&a);
    CHECK(memcmp(before, after, 144 * sizeof(double)) == 0);
    for (int i = 0; i < 12; i++)
        CHECK(rhs[i] == (sb_real)(i + 1));
    sb_matrix_constrain(&a, all, values, rhs); /* no free row is left to take a scale from: 1 */
    for (int i = 0; i < 12; i++)
        CHECK(rhs[i] == values[i]);
    free(after);
    after = dense_of(&a);
    for (int i = 0; i < 144; i++)
        CHECK(after[i] == (i % 13 == 0 ? 1 : 0));
    free(before);
    free(after);
    sb_matrix_free(&a);
}

/* ---- failures ---- */

static void check_refused(sb_result expected, int element, int nodes, int cells, int per_cell, const int *start,
                          const int *list)
{
    sb_matrix a, untouched;
    sb_error error;
    memset(&a, 0x5a, sizeof a);
    untouched = a;
    memset(&error, 0x5a, sizeof error);
    CHECK_RESULT(sb_matrix_create(nodes, cells, per_cell, start, list, NULL, &a, &error), expected);
    CHECK_INT(error.result, expected);
    CHECK_INT(error.element, element);
    CHECK(error.message[0] != 0);
    CHECK(memcmp(&a, &untouched, sizeof a) == 0);
    CHECK_RESULT(sb_matrix_create(nodes, cells, per_cell, start, list, NULL, &a, NULL), expected);
}

static void test_bad_input(void)
{
    static const int list[4] = {0, 1, 2, 3}, negative[4] = {0, 1, -1, 3};
    static const int late[3] = {1, 2, 4}, descending[4] = {0, 3, 2, 4};
    check_refused(SB_ERROR_ARGUMENT, -1, 0, 1, 4, NULL, list);
    check_refused(SB_ERROR_ARGUMENT, -1, -3, 1, 4, NULL, list);
    check_refused(SB_ERROR_ARGUMENT, -1, 4, -1, 4, NULL, list);
    check_refused(SB_ERROR_ARGUMENT, -1, 4, 1, 0, NULL, list);
    check_refused(SB_ERROR_ARGUMENT, -1, 4, 1, 4, NULL, NULL);
    check_refused(SB_ERROR_ARGUMENT, -1, 4, 2, 0, late, list);
    check_refused(SB_ERROR_ARGUMENT, 1, 4, 3, 0, descending, list);
    check_refused(SB_ERROR_INDEX, 1, 3, 2, 2, NULL, list);
    check_refused(SB_ERROR_INDEX, 0, 4, 1, 4, NULL, negative);
    CHECK_RESULT(sb_matrix_create(4, 1, 4, NULL, list, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
}

static void test_failing_memory(void)
{
    static const int tet[4] = {0, 1, 2, 3};
    int failures = 0;
    for (int n = 0; n < 20; n++) {
        failing_memory memory = {0, 0, 0};
        sb_allocator allocator = failing_allocator(&memory);
        sb_matrix a;
        sb_error error;
        memset(&a, 0, sizeof a);
        memory.fail_at = n;
        if (sb_matrix_create(4, 1, 4, NULL, tet, &allocator, &a, &error) == SB_OK) {
            sb_matrix_free(&a);
            CHECK_INT(memory.live, 0);
            break;
        }
        failures++;
        CHECK_INT(error.result, SB_ERROR_MEMORY);
        CHECK(a.memory == NULL);
        CHECK_INT(memory.live, 0);
    }
    CHECK_INT(failures, 2); /* scratch, matrix */
}

CHECK_SUITE(sparse, {"pattern of two tetrahedra", test_pattern_of_two_tets},
            {"pattern of a grid", test_pattern_of_grid}, {"lists equal fixed cells", test_lists_equal_fixed_cells},
            {"lists of any length", test_lists_of_any_length}, {"product equals dense", test_product_equals_dense},
            {"product on threads", test_product_on_threads}, {"asymmetry and clear", test_asymmetry},
            {"constrained equals reduced", test_constrain}, {"none or all constrained", test_constrain_extremes},
            {"bad input", test_bad_input}, {"failing memory", test_failing_memory});
