/* Tests of direct: factors of random and of elastic matrices against products and dense elimination, right-hand sides
 * one by one and together, orders and their fill, matrices that have no factor, bad input and failing allocations. */
#define SB_SPLIT_BUILD
#include "../src/softbody/solve/direct_front.h"
#include "check.h"
#include "scene.h"

/* ---- helpers ---- */

/* The pattern of a box of tetrahedra and where its nodes are. */
static sb_mesh box(int nx, int ny, int nz)
{
    return scene_box(SB_TET4, nx, ny, nz, sb_v3(REAL(nx), REAL(ny), REAL(nz)), 0.1);
}

static sb_matrix pattern_of(const sb_mesh *mesh)
{
    sb_matrix a;
    memset(&a, 0, sizeof a);
    CHECK_OK(sb_matrix_create(mesh->node_count, mesh->element_count, sb_mesh_element_width(mesh), NULL, mesh->elements,
                              NULL, &a, NULL));
    return a;
}

/* Random symmetric values; rows' diagonals outweigh the rest, with sign[i] (NULL: positive). */
static void fill(sb_matrix *a, double scale, const double *sign)
{
    unsigned long long seed = 5;
    for (int i = 0; i < a->row_count; i++)
        for (int q = a->row_start[i]; q < a->row_start[i + 1] && a->columns[q] <= i; q++)
            for (int k = 0; k < 9; k++) {
                sb_real value = REAL(scale * check_random_in(&seed, -1, 1));
                a->blocks[q][k] = value;
                a->blocks[a->transpose[q]][3 * (k % 3) + k / 3] = value;
            }
    for (int i = 0; i < a->row_count; i++)
        for (int r = 0; r < 3; r++)
            a->blocks[a->diagonal[i]][4 * r] =
                REAL(scale * (sign ? sign[i] : 1) * (3 + 2 * (a->row_start[i + 1] - a->row_start[i])));
}

/* The stiffness of a box of linear tetrahedra, lambda = mu = 1, its nodes at x = 0 held when `held`. */
static void fill_elastic(sb_matrix *a, const sb_mesh *mesh, int held)
{
    unsigned char *mask = (unsigned char *)calloc((size_t)mesh->node_count, 1);
    sb_matrix_clear(a);
    for (int t = 0; t < mesh->element_count; t++) {
        const int *c = mesh->elements + 4 * t;
        const sb_vec3 *x = mesh->nodes;
        sb_vec3 e1 = sb_v3_sub(x[c[1]], x[c[0]]), e2 = sb_v3_sub(x[c[2]], x[c[0]]);
        sb_vec3 e3 = sb_v3_sub(x[c[3]], x[c[0]]), g[4];
        sb_real six = sb_v3_dot(e1, sb_v3_cross(e2, e3));
        g[1] = sb_v3_scale(1 / six, sb_v3_cross(e2, e3));
        g[2] = sb_v3_scale(1 / six, sb_v3_cross(e3, e1));
        g[3] = sb_v3_scale(1 / six, sb_v3_cross(e1, e2));
        g[0] = sb_v3_scale(-1, sb_v3_add(g[1], sb_v3_add(g[2], g[3])));
        for (int i = 0; i < 4; i++)
            for (int j = 0; j < 4; j++) {
                sb_mat3 k = sb_m3_add(sb_m3_outer(g[i], g[j]), sb_m3_outer(g[j], g[i]));
                sb_real *block = a->blocks[sb_matrix_find(a, c[i], c[j])];
                for (int r = 0; r < 9; r++)
                    block[r] += six / 6 * (k.m[r / 3][r % 3] + (r % 4 == 0 ? sb_v3_dot(g[i], g[j]) : 0));
            }
    }
    for (int i = 0; i < mesh->node_count; i++)
        mask[i] = (unsigned char)(held && mesh->nodes[i].x < REAL(1e-5) ? SB_XYZ : 0);
    sb_matrix_constrain(a, mask, NULL, NULL);
    free(mask);
}

static sb_real *random_vector(int count, unsigned long long seed)
{
    sb_real *v = (sb_real *)malloc((size_t)count * sizeof(sb_real));
    for (int i = 0; i < count; i++)
        v[i] = REAL(check_random_in(&seed, -1, 1));
    return v;
}

static sb_direct *make(const sb_matrix *a, const sb_vec3 *positions, sb_direct_kind kind)
{
    sb_direct_def def = sb_default_direct_def();
    sb_direct *direct = NULL;
    def.kind = kind;
    def.positions = positions;
    CHECK_OK(sb_direct_create(&def, a, NULL, &direct, NULL));
    return direct;
}

/* Largest |A x - b| of a solve with random b over the largest |A| |x| + |b|: the relative change of the system that
 * would make x exact. */
static double residual(sb_direct *direct, const sb_matrix *a)
{
    int n = 3 * a->row_count;
    sb_real *b = random_vector(n, 3), *x = random_vector(n, 4), *y = random_vector(n, 5);
    double worst = 0, entry = 0, solution = 0;
    CHECK_OK(sb_direct_solve(direct, b, x, 1));
    sb_matrix_multiply(a, x, y, NULL);
    for (int i = 0; i < n; i++) {
        worst = fmax(worst, fabs((double)(y[i] - b[i])));
        solution = fmax(solution, fabs((double)x[i]));
    }
    for (int q = 0; q < a->block_count; q++)
        for (int k = 0; k < 9; k++)
            entry = fmax(entry, fabs((double)a->blocks[q][k]));
    free(b);
    free(x);
    free(y);
    return worst / (entry * solution + 1);
}

/* ---- factors ---- */

static void test_random(void)
{
    const int sizes[5][3] = {{1, 1, 1}, {3, 2, 1}, {9, 3, 3}, {6, 7, 8}, {40, 1, 1}};
    for (int k = 0; k < 5; k++)
        for (int with = 0; with < 2; with++)
            for (int scale = -1; scale < 2; scale++) {
                sb_mesh mesh = box(sizes[k][0], sizes[k][1], sizes[k][2]);
                sb_matrix a = pattern_of(&mesh);
                sb_direct *direct = make(&a, with ? mesh.nodes : NULL, SB_DIRECT_CHOLESKY);
                fill(&a, pow(1e3, scale), NULL);
                CHECK_OK(sb_direct_update(direct, &a, NULL));
                CHECK(residual(direct, &a) < scene_tolerance(1e-14, 20));
                CHECK(sb_direct_get_info(direct).least_pivot > REAL(0.3));
                CHECK_INT(sb_direct_get_info(direct).unknowns, 3 * mesh.node_count);
                sb_direct_free(direct);
                sb_matrix_free(&a);
                sb_mesh_free(&mesh);
            }
}

/* A block, and a slender beam, ill-conditioned as such are. */
static void test_elastic(void)
{
    for (int k = 0; k < 2; k++) {
        sb_mesh mesh = k ? box(60, 2, 2) : box(10, 9, 8);
        sb_matrix a = pattern_of(&mesh);
        sb_direct *direct = make(&a, mesh.nodes, SB_DIRECT_CHOLESKY);
        fill_elastic(&a, &mesh, 1);
        CHECK_OK(sb_direct_update(direct, &a, NULL));
        CHECK(residual(direct, &a) < scene_tolerance(1e-14, 20));
        sb_direct_free(direct);
        sb_matrix_free(&a);
        sb_mesh_free(&mesh);
    }
}

/* Every column of the inverse against dense elimination, and the number of negative eigenvalues (Sylvester). */
static void test_signs(void)
{
    sb_mesh mesh = box(3, 3, 2);
    sb_matrix a = pattern_of(&mesh);
    int nodes = mesh.node_count, n = 3 * nodes, negative = 0;
    double *sign = (double *)calloc((size_t)nodes, sizeof(double));
    sb_real *unit = (sb_real *)calloc((size_t)(n * n), sizeof(sb_real));
    sb_real *dense = (sb_real *)calloc((size_t)(n * n), sizeof(sb_real));
    sb_real *x = (sb_real *)calloc((size_t)n, sizeof(sb_real));
    int *pivot = (int *)malloc((size_t)n * sizeof(int));
    sb_direct *direct = make(&a, NULL, SB_DIRECT_LDLT), *plain = make(&a, NULL, SB_DIRECT_CHOLESKY);
    double worst = 0;
    sb_error error;
    for (int i = 0; i < nodes; i++) {
        sign[i] = i % 3 == 1 ? -1 : 1;
        negative += sign[i] < 0 ? 3 : 0;
    }
    fill(&a, 1, sign);
    for (int i = 0; i < nodes; i++)
        for (int q = a.row_start[i]; q < a.row_start[i + 1]; q++)
            for (int k = 0; k < 9; k++)
                dense[(3 * i + k / 3) * n + 3 * a.columns[q] + k % 3] = a.blocks[q][k];
    for (int i = 0; i < n; i++)
        unit[i * n + i] = 1;
    CHECK_OK(sb_direct_update(direct, &a, NULL));
    CHECK_INT(sb_direct_get_info(direct).negative_pivots, negative);
    CHECK_OK(sb_direct_solve(direct, unit, unit, n)); /* in place */
    CHECK_INT(sb_lu_factor(dense, n, pivot), 0);
    for (int i = 0; i < n; i++) {
        memset(x, 0, (size_t)n * sizeof(sb_real));
        x[i] = 1;
        sb_lu_solve(dense, n, pivot, x);
        for (int k = 0; k < n; k++)
            worst = fmax(worst, fabs((double)(x[k] - unit[i * n + k])));
    }
    CHECK(worst < scene_tolerance(1e-15, 8));
    CHECK_RESULT(sb_direct_update(plain, &a, &error), SB_ERROR_INDEFINITE);
    CHECK(error.node >= 0 && sign[error.node] < 0);
    CHECK_RESULT(sb_direct_solve(plain, x, x, 1), SB_ERROR_ARGUMENT);
    fill(&a, 1, NULL); /* a good one after a bad one */
    CHECK_OK(sb_direct_update(plain, &a, NULL));
    CHECK(residual(plain, &a) < scene_tolerance(1e-14, 20));
    sb_direct_free(direct);
    sb_direct_free(plain);
    sb_matrix_free(&a);
    sb_mesh_free(&mesh);
    free(sign);
    free(unit);
    free(dense);
    free(x);
    free(pivot);
}

/* Many at once give the bits that each gives alone; so does the same solver after another matrix, and a second one. */
static void test_bits(void)
{
    enum { COUNT = 37 };
    sb_mesh mesh = box(7, 6, 5);
    sb_matrix a = pattern_of(&mesh);
    int n = 3 * mesh.node_count;
    sb_real *b = random_vector(COUNT * n, 8), *x = random_vector(COUNT * n, 9), *y = random_vector(n, 10);
    sb_direct *direct = make(&a, mesh.nodes, SB_DIRECT_CHOLESKY), *other = make(&a, mesh.nodes, SB_DIRECT_CHOLESKY);
    fill(&a, 1, NULL);
    CHECK_OK(sb_direct_update(direct, &a, NULL));
    CHECK_OK(sb_direct_solve(direct, b, x, COUNT));
    fill_elastic(&a, &mesh, 1);
    CHECK_OK(sb_direct_update(other, &a, NULL));
    fill(&a, 1, NULL);
    CHECK_OK(sb_direct_update(other, &a, NULL));
    for (int k = 0; k < COUNT; k++) {
        CHECK_OK(sb_direct_solve(k % 2 ? direct : other, b + k * n, y, 1));
        CHECK(memcmp(y, x + k * n, (size_t)n * sizeof(sb_real)) == 0);
    }
    CHECK_OK(sb_direct_solve(direct, b, y, 0));
    sb_direct_free(direct);
    sb_direct_free(other);
    sb_matrix_free(&a);
    sb_mesh_free(&mesh);
    free(b);
    free(x);
    free(y);
}

/* ---- orders ---- */

/* Nested dissection of a cube: L has some 31/4 n^(4/3) entries in theory for the 7-point star, and its tetrahedra reach
 * as far; an order by rows would have n^(5/3). */
static void test_fill(void)
{
    double least[2] = {0, 0};
    for (int with = 0; with < 2; with++) {
        sb_mesh mesh = box(15, 15, 15);
        sb_matrix a = pattern_of(&mesh);
        sb_direct *direct = make(&a, with ? mesh.nodes : NULL, SB_DIRECT_CHOLESKY);
        double n = mesh.node_count;
        least[with] = sb_direct_get_info(direct).factor_entries / 9;
        CHECK(least[with] < 10 * pow(n, 4.0 / 3));
        CHECK(least[with] > a.block_count / 2);
        sb_direct_free(direct);
        sb_matrix_free(&a);
        sb_mesh_free(&mesh);
    }
    CHECK(least[1] < 1.3 * least[0] && least[0] < 1.3 * least[1]);
}

/* Nodes without neighbours, islands, everything coupled with everything, a chain, a star. */
static void test_patterns(void)
{
    enum { N = 200 };
    int *cells = (int *)malloc(2 * N * sizeof(int)), all[N];
    for (int shape = 0; shape < 5; shape++) {
        int count = 0, per = 2;
        sb_matrix a;
        sb_direct *direct;
        for (int i = 0; i < N; i++)
            all[i] = i;
        for (int i = 1; i < N; i++)
            if (shape == 3 || shape == 4 || (shape == 1 && i % 10 != 0)) {
                cells[2 * count] = i;
                cells[2 * count++ + 1] = shape == 4 ? 0 : i - 1;
            }
        if (shape == 2) {
            per = N;
            count = 1;
        }
        memset(&a, 0, sizeof a);
        CHECK_OK(sb_matrix_create(N, count, per, NULL, shape == 2 ? all : cells, NULL, &a, NULL));
        fill(&a, 1, NULL);
        direct = make(&a, NULL, SB_DIRECT_CHOLESKY);
        CHECK_OK(sb_direct_update(direct, &a, NULL));
        CHECK(residual(direct, &a) < scene_tolerance(1e-14, 20));
        CHECK(shape == 2 || sb_direct_get_info(direct).factor_entries < (double)(90 * N));
        sb_direct_free(direct);
        sb_matrix_free(&a);
    }
    free(cells);
}

/* ---- failures ---- */

static void test_singular(void)
{
    sb_mesh mesh = box(5, 4, 3);
    sb_matrix a = pattern_of(&mesh);
    sb_direct *direct = make(&a, mesh.nodes, SB_DIRECT_CHOLESKY);
    sb_error error;
    fill_elastic(&a, &mesh, 0); /* nothing holds it */
    CHECK_RESULT(sb_direct_update(direct, &a, &error), SB_ERROR_INDEFINITE);
    CHECK(error.node >= 0 && error.node < mesh.node_count);
    sb_matrix_clear(&a);
    CHECK_RESULT(sb_direct_update(direct, &a, &error), SB_ERROR_INDEFINITE);
    fill(&a, 1, NULL);
    a.blocks[a.diagonal[17]][4] = REAL(NAN);
    check_bad_numbers();
    CHECK_RESULT(sb_direct_update(direct, &a, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.node, 17);
    a.blocks[a.diagonal[17]][4] = REAL(INFINITY);
    CHECK_RESULT(sb_direct_update(direct, &a, &error), SB_ERROR_NOT_FINITE);
    sb_direct_free(direct);
    sb_matrix_free(&a);
    sb_mesh_free(&mesh);
}

static void test_refusals(void)
{
    sb_mesh mesh = box(3, 2, 2), longer = box(4, 2, 2);
    sb_matrix a = pattern_of(&mesh), other = pattern_of(&longer), turned;
    sb_direct_def def = sb_default_direct_def();
    sb_direct *direct = NULL;
    sb_error error;
    sb_real value = 1;
    CHECK_RESULT(sb_direct_create(NULL, NULL, NULL, &direct, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_direct_create(NULL, &a, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    memset(&def.kind, 1, sizeof def.kind); /* no such kind, which C++ does not let us write */
    CHECK_RESULT(sb_direct_create(&def, &a, NULL, &direct, &error), SB_ERROR_ARGUMENT);
    def = sb_default_direct_def();
    def.positions = mesh.nodes;
    mesh.nodes[5].y = REAL(NAN);
    CHECK_RESULT(sb_direct_create(&def, &a, NULL, &direct, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.node, 5);
    CHECK(direct == NULL);
    CHECK_OK(sb_direct_create(NULL, &a, NULL, &direct, NULL));
    CHECK_RESULT(sb_direct_solve(direct, &value, &value, 1), SB_ERROR_ARGUMENT); /* no factor yet */
    CHECK_RESULT(sb_direct_update(direct, &other, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_direct_update(direct, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_direct_update(NULL, &a, &error), SB_ERROR_ARGUMENT);
    for (int e = 0; e < mesh.element_count * 4; e++) /* as many nodes and blocks, but others */
        mesh.elements[e] = mesh.node_count - 1 - mesh.elements[e];
    for (int e = 0; e < 4 * mesh.element_count; e++)
        mesh.elements[e] = (mesh.elements[e] + 7) % mesh.node_count;
    turned = pattern_of(&mesh);
    fill(&turned, 1, NULL);
    CHECK_INT(turned.block_count, a.block_count);
    CHECK_RESULT(sb_direct_update(direct, &turned, &error), SB_ERROR_ARGUMENT);
    sb_direct_free(direct);
    sb_direct_free(NULL);
    sb_matrix_free(&a);
    sb_matrix_free(&other);
    sb_matrix_free(&turned);
    sb_mesh_free(&mesh);
    sb_mesh_free(&longer);
}

static void test_memory(void)
{
    sb_mesh mesh = box(4, 3, 3);
    sb_matrix a = pattern_of(&mesh);
    sb_direct_def def = sb_default_direct_def();
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    sb_result result = SB_ERROR_MEMORY;
    sb_real *b = random_vector(3 * mesh.node_count, 1);
    def.positions = mesh.nodes;
    fill(&a, 1, NULL);
    for (int fail = 1; result == SB_ERROR_MEMORY && fail < 100; fail++) {
        sb_direct *direct = NULL;
        memory.calls = 0;
        memory.fail_at = fail;
        result = sb_direct_create(&def, &a, &allocator, &direct, NULL);
        CHECK(result == SB_OK || (result == SB_ERROR_MEMORY && !direct && memory.live == 0));
        if (direct) { /* nothing more is taken */
            int calls = memory.calls;
            CHECK_INT(memory.live, 2);
            CHECK_OK(sb_direct_update(direct, &a, NULL));
            CHECK_OK(sb_direct_solve(direct, b, b, 1));
            CHECK_INT(memory.calls, calls);
        }
        sb_direct_free(direct);
        CHECK_INT(memory.live, 0);
    }
    CHECK_OK(result);
    free(b);
    sb_matrix_free(&a);
    sb_mesh_free(&mesh);
}

/* Vectors of any width: fronts of odd sizes are factored and substituted to the same bits. Where the processor has no
 * wider ones there is but one way. */
static void test_widths(void)
{
    enum { MOST = 201, GROUPS = 3 };
    static const size_t sizes[][2] = {{3, 3}, {9, 6}, {51, 33}, {132, 48}, {201, 99}};
    const size_t x_size = (size_t)GROUPS * MOST * SBI_FRONT_GROUP;
    sb_real *random = random_vector(MOST * MOST, 17), *pack = random_vector(SBI_FRONT_PACK + MOST * SBI_FRONT_GROUP, 1);
    int rows[MOST];
    for (int i = 0; i < MOST; i++)
        rows[i] = i;
    for (int c = 0; c < (int)(sizeof sizes / sizeof *sizes); c++) {
        const size_t height = sizes[c][0], width = sizes[c][1], below = height - width;
        sb_real *panel[2], *square[2], *x[2];
        for (int wide = 0; wide < 2; wide++) {
            sb_real signs[MOST], largest[MOST];
            sb_direct_info info;
            memset(&info, 0, sizeof info);
            panel[wide] = (sb_real *)calloc(height * width, sizeof(sb_real));
            square[wide] = (sb_real *)calloc(below * below + SBI_FRONT_REACH, sizeof(sb_real));
            x[wide] = random_vector((int)x_size, 5);
            for (size_t k = 0; k < width; k++) {
                for (size_t r = k; r < height; r++)
                    panel[wide][k * height + r] = random[k * MOST + r] + (r == k ? REAL(2 * MOST) : 0);
                largest[k] = REAL(2 * MOST);
            }
            CHECK_INT(sbi_front_factor(panel[wide], height, width, 0, signs, largest, pack,
                                       wide && sbi_lanes_are_wide(), &info),
                      -1);
            sbi_front_square(panel[wide], height, width, 0, signs, square[wide], pack, wide && sbi_lanes_are_wide());
            sbi_front_forward(panel[wide], height, width, x[wide], SBI_FRONT_GROUP, wide && sbi_lanes_are_wide());
            sbi_front_backward(panel[wide], height, width, x[wide], SBI_FRONT_GROUP, wide && sbi_lanes_are_wide());
            sbi_front_forward_many(panel[wide], height, width, x[wide], GROUPS, pack, wide && sbi_lanes_are_wide());
            sbi_front_backward_many(panel[wide], height, width, rows, x[wide], height, GROUPS, pack,
                                    wide && sbi_lanes_are_wide());
        }
        CHECK(memcmp(panel[0], panel[1], height * width * sizeof(sb_real)) == 0);
        CHECK(memcmp(square[0], square[1], below * below * sizeof(sb_real)) == 0);
        CHECK(memcmp(x[0], x[1], x_size * sizeof(sb_real)) == 0 && isfinite((double)x[0][0]));
        for (int wide = 0; wide < 2; wide++) {
            free(panel[wide]);
            free(square[wide]);
            free(x[wide]);
        }
    }
    free(random);
    free(pack);
}

CHECK_SUITE(direct, {"random matrices", test_random}, {"elastic matrices", test_elastic}, {"signs", test_signs},
            {"the same bits", test_bits}, {"fill", test_fill}, {"patterns", test_patterns},
            {"matrices without a factor", test_singular}, {"refusals", test_refusals},
            {"vectors of any width", test_widths}, {"failing allocations", test_memory});
