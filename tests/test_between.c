/* Tests of direct_between: products of sparse vectors with the inverse between them, against solves of the same factor,
 * entry by entry; vectors that are empty, dense or alike; definite and indefinite matrices; failing allocations. It is
 * internal. */
#define SB_SPLIT_BUILD
#include "../src/softbody/solve/direct_between.h"

#include "check.h"
#include "scene.h"

enum { LEFTS = 11, RIGHTS = 23, MOST = 4000 };

static sb_matrix pattern_of(const sb_mesh *mesh)
{
    sb_matrix a;
    memset(&a, 0, sizeof a);
    CHECK_OK(sb_matrix_create(mesh->node_count, mesh->element_count, sb_mesh_element_width(mesh), NULL, mesh->elements,
                              NULL, &a, NULL));
    return a;
}

/* Random symmetric values; rows' diagonals outweigh the rest. Every `turned`-th node has a negative one; 0: none. */
static void fill(sb_matrix *a, int turned)
{
    unsigned long long seed = 5;
    for (int i = 0; i < a->row_count; i++)
        for (int q = a->row_start[i]; q < a->row_start[i + 1] && a->columns[q] <= i; q++)
            for (int k = 0; k < 9; k++) {
                sb_real value = REAL(check_random_in(&seed, -1, 1));
                a->blocks[q][k] = value;
                a->blocks[a->transpose[q]][3 * (k % 3) + k / 3] = value;
            }
    for (int i = 0; i < a->row_count; i++)
        for (int r = 0; r < 3; r++)
            a->blocks[a->diagonal[i]][4 * r] =
                REAL((turned && i % turned == 0 ? -1 : 1) * (3.0 + 2 * (a->row_start[i + 1] - a->row_start[i])));
}

/* Left k: none, one node twice, a few at random, all. Adds to between (NULL: not) and to dense[3 n]. */
static void make_left(int k, int n, sbi_between *between, sb_real *dense)
{
    unsigned long long seed = 77 + (unsigned long long)k;
    int count = k % 4 == 0 ? 0 : k % 4 == 1 ? 2 : k % 4 == 2 ? 7 : n;
    memset(dense, 0, (size_t)(3 * n) * sizeof *dense);
    for (int i = 0; i < count; i++) {
        int node = k % 4 == 3 ? i : k % 4 == 1 ? k % n : (int)check_random_in(&seed, 0, n - 0.001);
        sb_vec3 v;
        v.x = REAL(check_random_in(&seed, -1, 1));
        v.y = REAL(check_random_in(&seed, -1, 1));
        v.z = REAL(check_random_in(&seed, -1, 1));
        dense[3 * node] += v.x;
        dense[3 * node + 1] += v.y;
        dense[3 * node + 2] += v.z;
        if (between)
            sbi_between_add(between, k, node, v);
    }
}

/* What a right has at a node: nothing, at one node, at a few, at all. */
static double weight_of(int right, int node, int n)
{
    unsigned long long seed = 1000u * (unsigned long long)right + (unsigned long long)node;
    double value = check_random_in(&seed, -1, 1);
    int kind = right % 4;
    return kind == 0 || (kind == 1 && node != right % n) || (kind == 2 && (node + right) % 5) ? 0 : value;
}

/* The rights by node; every tenth weight is given in two halves. */
typedef struct right_side {
    sbi_between_rights rights;
    int *start, *columns;
    sb_real *weights;
} right_side;

static right_side make_rights(int n)
{
    right_side side;
    int at = 0;
    side.start = (int *)malloc((size_t)(n + 1) * sizeof(int));
    side.columns = (int *)malloc((size_t)(2 * RIGHTS * n) * sizeof(int));
    side.weights = (sb_real *)malloc((size_t)(2 * RIGHTS * n) * sizeof(sb_real));
    for (int i = 0; i < n; i++) {
        side.start[i] = at;
        for (int r = RIGHTS - 1; r >= 0; r--)
            for (int half = 0, parts = (r + i) % 10 ? 1 : 2; half < parts && weight_of(r, i, n) != 0; half++) {
                side.columns[at] = r;
                side.weights[at++] = REAL(weight_of(r, i, n) / parts);
            }
    }
    side.start[n] = at;
    side.rights.start = side.start;
    side.rights.columns = side.columns;
    side.rights.weights = side.weights;
    return side;
}

static void free_rights(right_side *side)
{
    free(side->start);
    free(side->columns);
    free(side->weights);
}

static sb_direct *make(const sb_matrix *a, const sb_mesh *mesh, sb_direct_kind kind)
{
    sb_direct_def def = sb_default_direct_def();
    sb_direct *direct = NULL;
    def.kind = kind;
    def.positions = mesh->nodes;
    CHECK_OK(sb_direct_create(&def, a, NULL, &direct, NULL));
    return direct;
}

/* Largest difference to solves, over the largest product. */
static double difference(const sbi_between *between, sb_direct *direct, int n)
{
    sb_real *x = (sb_real *)malloc((size_t)(3 * n) * sizeof *x);
    double worst = 0, most = 0;
    for (int l = 0; l < LEFTS; l++) {
        make_left(l, n, NULL, x);
        CHECK_OK(sb_direct_solve(direct, x, x, 1));
        for (int r = 0; r < RIGHTS; r++) {
            double sum[3] = {0, 0, 0};
            sb_vec3 found = sbi_between_get(between, l, r);
            const double got[3] = {(double)found.x, (double)found.y, (double)found.z};
            for (int i = 0; i < 3 * n; i++)
                sum[i % 3] += (double)x[i] * weight_of(r, i / 3, n);
            for (int axis = 0; axis < 3; axis++) {
                worst = fmax(worst, fabs(sum[axis] - got[axis]));
                most = fmax(most, fabs(sum[axis]));
            }
        }
    }
    free(x);
    return worst / most;
}

static void try_box(int nx, int ny, int nz, sb_direct_kind kind)
{
    sb_mesh mesh = scene_box(SB_TET4, nx, ny, nz, sb_v3(REAL(nx), REAL(ny), REAL(nz)), 0.1);
    sb_matrix a = pattern_of(&mesh);
    sb_direct *direct = make(&a, &mesh, kind);
    int n = mesh.node_count;
    sb_real *dense = (sb_real *)malloc((size_t)(3 * n) * sizeof *dense);
    right_side rights = make_rights(n);
    sbi_between *between = NULL;
    CHECK_OK(sbi_between_create(direct, LEFTS, RIGHTS, (size_t)(LEFTS * (n + 7)), NULL, &between, NULL));
    CHECK_RESULT(sbi_between_run(between, &rights.rights), SB_ERROR_ARGUMENT); /* no factor yet */
    for (int again = 0; again < 2; again++) { /* another matrix, the same vectors anew */
        fill(&a, kind == SB_DIRECT_LDLT ? 3 + again : 0);
        CHECK_OK(sb_direct_update(direct, &a, NULL));
        sbi_between_clear(between);
        for (int k = 0; k < LEFTS; k++)
            make_left(k, n, between, dense);
        CHECK_OK(sbi_between_run(between, &rights.rights));
        CHECK(difference(between, direct, n) < scene_tolerance(1e-14, 20));
    }
    sbi_between_free(between);
    free_rights(&rights);
    free(dense);
    sb_direct_free(direct);
    sb_matrix_free(&a);
    sb_mesh_free(&mesh);
}

static void test_definite(void)
{
    try_box(1, 1, 1, SB_DIRECT_CHOLESKY);
    try_box(6, 5, 4, SB_DIRECT_CHOLESKY);
    try_box(30, 2, 1, SB_DIRECT_CHOLESKY);
    try_box(9, 8, 8, SB_DIRECT_CHOLESKY);
}

static void test_indefinite(void)
{
    try_box(2, 1, 1, SB_DIRECT_LDLT);
    try_box(6, 5, 4, SB_DIRECT_LDLT);
}

static void test_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    sb_mesh mesh = scene_box(SB_TET4, 4, 3, 2, sb_v3(4, 3, 2), 0.1);
    sb_matrix a = pattern_of(&mesh);
    sb_direct *direct = make(&a, &mesh, SB_DIRECT_CHOLESKY);
    sb_result result = SB_ERROR_MEMORY;
    for (int fail = 1; result == SB_ERROR_MEMORY && fail < 100; fail++) {
        sbi_between *between = NULL;
        memory.calls = 0;
        memory.fail_at = fail;
        result = sbi_between_create(direct, LEFTS, RIGHTS, MOST, &allocator, &between, NULL);
        CHECK((between != NULL) == (result == SB_OK));
        sbi_between_free(between);
        CHECK_INT(memory.live, 0);
    }
    CHECK_OK(result);
    sbi_between_free(NULL);
    sb_direct_free(direct);
    sb_matrix_free(&a);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(between, {"definite matrices", test_definite}, {"indefinite matrices", test_indefinite},
            {"failing allocations", test_memory});
