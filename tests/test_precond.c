/* Tests of precond's approximate inverses, complete factors, rotations and saved bytes: applications against dense
 * formulas, iteration counts on a bent beam, threads, forged images, failing memory. */
#include "check.h"
#include "image.h"
#include "scene.h"

/* ---- helpers ---- */

/* A beam along x, and the system of one implicit step of a corotated body in some shape: M / dt^2 + K. */
typedef struct beam {
    sb_mesh mesh;
    int n; /* nodes */
    sb_matrix a;
    unsigned char *mask;
    sb_real *rhs;
} beam;

/* Gradients of the barycentric coordinates; returns the volume. */
static double tet_gradients(const sb_vec3 *x, const int *c, sb_vec3 g[4])
{
    sb_vec3 e1 = sb_v3_sub(x[c[1]], x[c[0]]), e2 = sb_v3_sub(x[c[2]], x[c[0]]), e3 = sb_v3_sub(x[c[3]], x[c[0]]);
    sb_real six = sb_v3_dot(e1, sb_v3_cross(e2, e3));
    g[1] = sb_v3_scale(1 / six, sb_v3_cross(e2, e3));
    g[2] = sb_v3_scale(1 / six, sb_v3_cross(e3, e1));
    g[3] = sb_v3_scale(1 / six, sb_v3_cross(e1, e2));
    g[0] = sb_v3_scale(-1, sb_v3_add(g[1], sb_v3_add(g[2], g[3])));
    return (double)six / 6;
}

/* Values of the matrix with the nodes at now[]: each element's stiffness at rest, turned with the element. */
static void beam_fill(beam *b, const sb_vec3 *now, double young, double poisson, double mass)
{
    double lambda = young * poisson / ((1 + poisson) * (1 - 2 * poisson)), mu = young / (2 * (1 + poisson));
    sb_matrix_clear(&b->a);
    memset(b->rhs, 0, 3 * (size_t)b->n * sizeof(sb_real));
    for (int t = 0; t < b->mesh.element_count; t++) {
        const int *c = b->mesh.elements + 4 * t;
        sb_vec3 g[4];
        double volume = tet_gradients(b->mesh.nodes, c, g);
        sb_mat3 f = sb_m3_zero(), r;
        for (int i = 0; i < 4; i++)
            f = sb_m3_add(f, sb_m3_outer(now[c[i]], g[i]));
        r = sb_quat_to_mat3(sb_m3_polar_cold(f));
        for (int i = 0; i < 4; i++) {
            for (int j = 0; j < 4; j++) {
                sb_mat3 k = sb_m3_add(sb_m3_scale(REAL(lambda), sb_m3_outer(g[i], g[j])),
                                      sb_m3_scale(REAL(mu), sb_m3_outer(g[j], g[i])));
                sb_real *block = b->a.blocks[sb_matrix_find(&b->a, c[i], c[j])];
                for (int d = 0; d < 3; d++)
                    k.m[d][d] += REAL(mu) * sb_v3_dot(g[i], g[j]);
                k = sb_m3_mult(sb_m3_mul(r, k), r);
                for (int d = 0; d < 9; d++)
                    block[d] += REAL(volume) * k.m[d / 3][d % 3];
            }
            for (int d = 0; d < 3; d++)
                b->a.blocks[b->a.diagonal[c[i]]][4 * d] += REAL(mass * volume / 4);
            b->rhs[3 * c[i] + 2] -= REAL(volume / 4);
        }
    }
    sb_matrix_constrain(&b->a, b->mask, NULL, b->rhs);
}

/* Slender by 5:1, clamped at x = 0. */
static beam beam_make(int nx, int ny, double length, double shake)
{
    beam b;
    memset(&b, 0, sizeof b);
    b.mesh = scene_box(SB_TET4, nx, ny, ny, sb_v3(REAL(length), REAL(length / 5), REAL(length / 5)), shake);
    b.n = b.mesh.node_count;
    b.mask = (unsigned char *)calloc((size_t)b.n, 1);
    b.rhs = (sb_real *)calloc(3 * (size_t)b.n, sizeof(sb_real));
    for (int i = 0; i < b.n; i++)
        b.mask[i] = (unsigned char)(b.mesh.nodes[i].x < REAL(1e-5 * length) ? SB_XYZ : 0);
    CHECK_OK(sb_matrix_create(b.n, b.mesh.element_count, 4, NULL, b.mesh.elements, NULL, &b.a, NULL));
    beam_fill(&b, b.mesh.nodes, 5e3, 0.45, 1000 / (0.05 * 0.05));
    return b;
}

static void beam_free(beam *b)
{
    sb_mesh_free(&b->mesh);
    sb_matrix_free(&b->a);
    free(b->mask);
    free(b->rhs);
}

static sb_preconditioner *make(const sb_matrix *a, sb_precond_kind kind, int power, const sb_vec3 *positions,
                               int pieces)
{
    sb_preconditioner_def def = sb_default_preconditioner_def();
    sb_preconditioner *p = NULL;
    def.kind = kind;
    def.power = power;
    def.positions = positions;
    def.piece_count = pieces;
    CHECK_OK(sb_preconditioner_create(&def, a, NULL, &p, NULL));
    return p;
}

static sb_preconditioner *make_updated(const beam *b, sb_precond_kind kind, int power, int pieces)
{
    sb_preconditioner *p = make(&b->a, kind, power, b->mesh.nodes, pieces);
    CHECK_OK(sb_preconditioner_update(p, &b->a, NULL, NULL));
    return p;
}

/* Iterations of a solve, 0 when it fails. */
static int iterations(const beam *b, sb_preconditioner *p, double tolerance)
{
    sb_pcg_options options = sb_default_pcg_options();
    sb_pcg_workspace workspace;
    sb_pcg_info info;
    sb_real *x = (sb_real *)calloc(3 * (size_t)b->n, sizeof(sb_real));
    sb_result result;
    options.tolerance = tolerance;
    options.max_iterations = 5000;
    CHECK_OK(sb_pcg_workspace_create(b->n, NULL, &workspace, NULL));
    result = sb_pcg_solve(&b->a, p, b->rhs, x, &options, &workspace, &info);
    sb_pcg_workspace_free(&workspace);
    free(x);
    return result == SB_OK ? info.iterations : 0;
}

static sb_real *random_vector(int count, unsigned long long seed)
{
    sb_real *v = (sb_real *)malloc((size_t)count * sizeof(sb_real));
    for (int i = 0; i < count; i++)
        v[i] = REAL(check_random_in(&seed, -1, 1));
    return v;
}

/* The smoothers work in single precision in any build. */
#define SINGLE 1.2e-7

static double largest_difference(const sb_real *a, const double *b, int count)
{
    double worst = 0, size = 0;
    for (int i = 0; i < count; i++) {
        worst = fmax(worst, fabs((double)a[i] - b[i]));
        size = fmax(size, fabs(b[i]));
    }
    return worst / size;
}

/* ---- the approximate inverse ---- */

/* near[i n + j]: nodes i and j are at most `power` blocks apart. */
static unsigned char *dense_pattern(const sb_matrix *a, int power)
{
    size_t n = (size_t)a->row_count;
    unsigned char *within = (unsigned char *)calloc(n * n, 1), *next = (unsigned char *)calloc(n * n, 1);
    for (size_t i = 0; i < n; i++)
        within[i * n + i] = 1;
    for (; power > 0; power--) {
        unsigned char *swap = within;
        memset(next, 0, n * n);
        for (size_t i = 0; i < n; i++)
            for (size_t j = 0; j < n; j++)
                for (int q = a->row_start[j]; within[i * n + j] && q < a->row_start[j + 1]; q++)
                    next[i * n + (size_t)a->columns[q]] = 1;
        within = next;
        next = swap;
    }
    free(next);
    return within;
}

/* The three rows of G of node i: the last of L^-1, L L^T = A_JJ, by elimination of the identity beside it. */
static void dense_row(const sb_matrix *a, const unsigned char *within, int i, double *rows)
{
    int n = a->row_count, nodes[400], count = 0, m;
    double *k, *inverse;
    for (int j = 0; j <= i; j++)
        if (within[(size_t)i * (size_t)n + (size_t)j])
            nodes[count++] = j;
    m = 3 * count;
    k = (double *)calloc((size_t)m * (size_t)m, sizeof(double));
    inverse = (double *)calloc((size_t)m * (size_t)m, sizeof(double));
    for (int r = 0; r < m; r++) {
        inverse[r * m + r] = 1;
        for (int c = 0; c < m; c++) {
            int q = sb_matrix_find(a, nodes[r / 3], nodes[c / 3]);
            k[r * m + c] = q < 0 ? 0 : (double)a->blocks[q][3 * (r % 3) + c % 3];
        }
    }
    for (int r = 0; r < m; r++) {
        double pivot = 1 / sqrt(k[r * m + r]);
        for (int c = 0; c < m; c++) {
            k[r * m + c] *= pivot;
            inverse[r * m + c] *= pivot;
        }
        for (int below = r + 1; below < m; below++) {
            double factor = k[below * m + r] * pivot;
            for (int c = 0; c < m; c++) {
                k[below * m + c] -= factor * k[r * m + c];
                inverse[below * m + c] -= factor * inverse[r * m + c];
            }
        }
    }
    memset(rows, 0, 9 * (size_t)n * sizeof(double));
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < m; c++)
            rows[r * 3 * n + 3 * nodes[c / 3] + c % 3] = inverse[(m - 3 + r) * m + c];
    free(k);
    free(inverse);
}

static void check_dense(const sb_matrix *a, int power)
{
    int n = 3 * a->row_count;
    unsigned char *within = dense_pattern(a, power);
    sb_preconditioner *p = make(a, SB_PRECOND_FSAI, power, NULL, 0);
    double *rows = (double *)malloc(3 * (size_t)n * sizeof(double)), *z = (double *)calloc((size_t)n, sizeof(double));
    sb_real *r = random_vector(n, 9), *out = random_vector(n, 10);
    for (int i = 0; i < a->row_count; i++) {
        dense_row(a, within, i, rows);
        for (int k = 0; k < 3; k++) {
            double y = 0;
            for (int c = 0; c < n; c++)
                y += rows[k * n + c] * (double)r[c];
            for (int c = 0; c < n; c++)
                z[c] += rows[k * n + c] * y;
        }
    }
    CHECK_OK(sb_preconditioner_update(p, a, NULL, NULL));
    sb_preconditioner_apply(p, r, out);
    CHECK(largest_difference(out, z, n) < 300 * SINGLE);
    CHECK(sb_preconditioner_get_info(p).shift == 0);
    CHECK(sb_preconditioner_get_info(p).kind == SB_PRECOND_FSAI);
    sb_preconditioner_free(p);
    free(within);
    free(rows);
    free(z);
    free(r);
    free(out);
}

static void test_fsai_dense(void)
{
    beam b = beam_make(9, 2, 0.2, 0.2);
    for (int power = 1; power <= SB_PRECOND_MAX_POWER; power++)
        check_dense(&b.a, power);
    beam_free(&b);
}

/* Where every node is within reach of every other, G^T G is the inverse. */
static void test_fsai_complete(void)
{
    beam b = beam_make(3, 1, 0.2, 0);
    sb_preconditioner *p = make_updated(&b, SB_PRECOND_FSAI, 3, 0);
    sb_real *x = random_vector(3 * b.n, 4), *ax = random_vector(3 * b.n, 5), *z = random_vector(3 * b.n, 6);
    double *exact = (double *)malloc(3 * (size_t)b.n * sizeof(double));
    sb_matrix_multiply(&b.a, x, ax, NULL);
    for (int i = 0; i < 3 * b.n; i++)
        exact[i] = (double)x[i];
    sb_preconditioner_apply(p, ax, z);
    CHECK(largest_difference(z, exact, 3 * b.n) < 1e-3); /* rounding in single precision times the condition */
    sb_preconditioner_free(p);
    free(x);
    free(ax);
    free(z);
    free(exact);
    beam_free(&b);
}

/* One node: nothing to couple. */
static void test_fsai_one_node(void)
{
    sb_matrix a;
    sb_preconditioner *p;
    const sb_real r[3] = {4, 8, 12};
    sb_real z[3] = {0, 0, 0};
    CHECK_OK(sb_matrix_create(1, 0, 1, NULL, NULL, NULL, &a, NULL));
    for (int k = 0; k < 3; k++)
        a.blocks[0][4 * k] = 4;
    p = make(&a, SB_PRECOND_FSAI, 2, NULL, 0);
    CHECK_OK(sb_preconditioner_update(p, &a, NULL, NULL));
    sb_preconditioner_apply(p, r, z);
    for (int k = 0; k < 3; k++)
        CHECK_NEAR(z[k], (double)k + 1, 10 * SINGLE);
    sb_preconditioner_free(p);
    sb_matrix_free(&a);
}

/* A row's matrix that is not positive definite gets a shift; a negative diagonal is hopeless. */
static void test_fsai_shift(void)
{
    check_bad_numbers();
    const int pair[2] = {0, 1};
    sb_matrix a;
    sb_preconditioner *p;
    sb_error error;
    CHECK_OK(sb_matrix_create(2, 1, 2, NULL, pair, NULL, &a, NULL));
    p = make(&a, SB_PRECOND_FSAI, 1, NULL, 0);
    for (int k = 0; k < 3; k++) {
        a.blocks[a.diagonal[0]][4 * k] = a.blocks[a.diagonal[1]][4 * k] = 1;
        a.blocks[sb_matrix_find(&a, 0, 1)][4 * k] = a.blocks[sb_matrix_find(&a, 1, 0)][4 * k] = REAL(1.5);
    }
    CHECK_OK(sb_preconditioner_update(p, &a, NULL, NULL));
    CHECK(sb_preconditioner_get_info(p).shift > 0.5 && sb_preconditioner_get_info(p).shift < 1.1);
    a.blocks[a.diagonal[1]][4] = -1;
    CHECK_RESULT(sb_preconditioner_update(p, &a, NULL, &error), SB_ERROR_INDEFINITE);
    CHECK_INT(error.node, 1);
    a.blocks[a.diagonal[1]][4] = 1;
    for (int k = 0; k < 3; k++)
        a.blocks[sb_matrix_find(&a, 0, 1)][4 * k] = REAL(1e6);
    CHECK_RESULT(sb_preconditioner_update(p, &a, NULL, &error), SB_ERROR_INDEFINITE);
    CHECK_INT(error.node, 1);
    a.blocks[a.diagonal[0]][0] = REAL(NAN);
    CHECK_RESULT(sb_preconditioner_update(p, &a, NULL, &error), SB_ERROR_NOT_FINITE);
    sb_preconditioner_free(p);
    sb_matrix_free(&a);
}

static void test_iteration_counts(void)
{
    beam b = beam_make(30, 6, 0.2, 0);
    const struct {
        sb_precond_kind kind;
        int power, pieces, most;
    } rows[] = {{SB_PRECOND_IC0, 1, 0, 78},  {SB_PRECOND_FSAI, 1, 0, 168}, {SB_PRECOND_FSAI, 2, 0, 100},
                {SB_PRECOND_FSAI, 3, 0, 68}, {SB_PRECOND_FSAI, 1, 16, 26}, {SB_PRECOND_CHOLESKY, 1, -1, 1}};
    for (int k = 0; k < (int)(sizeof rows / sizeof *rows); k++) {
        sb_preconditioner *p = make_updated(&b, rows[k].kind, rows[k].power, rows[k].pieces);
        int count = iterations(&b, p, 1e-3);
        if (!CHECK(count >= 1 && count <= rows[k].most))
            printf("    kind %d power %d pieces %d: %d iterations\n", (int)rows[k].kind, rows[k].power, rows[k].pieces,
                   count);
        sb_preconditioner_free(p);
    }
    beam_free(&b);
}

/* The same system in other units takes the same iterations. */
static void test_scales(void)
{
    int counts[3];
    for (int s = 0; s < 3; s++) {
        beam b = beam_make(15, 3, 0.2, 0);
        double scale = pow(1e3, s - 1);
        sb_preconditioner *p;
        for (int q = 0; q < b.a.block_count; q++)
            for (int k = 0; k < 9; k++)
                b.a.blocks[q][k] *= REAL(scale);
        p = make_updated(&b, SB_PRECOND_FSAI, 1, 0);
        counts[s] = iterations(&b, p, 1e-3);
        CHECK(counts[s] > 5);
        sb_preconditioner_free(p);
        beam_free(&b);
    }
    CHECK(abs(counts[0] - counts[1]) <= 1 && abs(counts[2] - counts[1]) <= 1);
}

/* ---- rotations ---- */

/* Where a point of a beam goes that is bent to a quarter circle, upwards. */
static sb_vec3 bend(sb_vec3 x, double length, double height)
{
    double radius = length / (2 * atan(1.0)), angle = (double)x.x / radius, r = radius - ((double)x.z - height / 2);
    return sb_v3(REAL(r * sin(angle)), x.y, REAL(radius + height / 2 - r * cos(angle)));
}

static sb_vec3 *bent_nodes(const sb_mesh *mesh, double length)
{
    sb_vec3 *now = (sb_vec3 *)malloc((size_t)mesh->node_count * sizeof(sb_vec3));
    for (int i = 0; i < mesh->node_count; i++)
        now[i] = bend(mesh->nodes[i], length, length / 5);
    return now;
}

/* Rotations of the mesh's nodes when they are at now[]. */
static sb_quat *rotations_of(const sb_mesh *mesh, const sb_vec3 *now)
{
    sb_quat *rotations = (sb_quat *)malloc((size_t)mesh->node_count * sizeof(sb_quat));
    sb_vec3 *moved = (sb_vec3 *)malloc((size_t)mesh->node_count * sizeof(sb_vec3));
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    def.mesh = mesh;
    def.material = sb_material_corotated(5000, REAL(0.45), 1000);
    body = scene_body(&def);
    for (int i = 0; i < mesh->node_count; i++)
        moved[i] = sb_v3_sub(now[i], mesh->nodes[i]);
    CHECK_OK(sb_body_set_displacements(body, moved));
    sb_body_nodal_rotations(body, rotations);
    sb_body_destroy(body);
    free(moved);
    return rotations;
}

/* What the published measurements show: made at rest and turned, a smoother is as good in a strongly bent body as one
 * made anew, and without being turned it is of little use. */
static void test_bent_beam(void)
{
    const double length = 0.3, mass = 1000 / (0.1 * 0.1), tolerance = SB_REAL_IS_FLOAT ? 1e-2 : 1e-3;
    beam b = beam_make(30, 6, length, 0);
    sb_vec3 *now = bent_nodes(&b.mesh, length);
    sb_quat *rotations = rotations_of(&b.mesh, now);
    const sb_precond_kind kinds[3] = {SB_PRECOND_FSAI, SB_PRECOND_IC0, SB_PRECOND_BLOCK_JACOBI};
    for (int k = 0; k < 3; k++) {
        sb_preconditioner *p;
        int current, warped, unwarped;
        beam_fill(&b, now, 5e3, 0.45, mass);
        p = make_updated(&b, kinds[k], 1, 0);
        current = iterations(&b, p, tolerance);
        sb_preconditioner_free(p);
        beam_fill(&b, b.mesh.nodes, 5e3, 0.45, mass);
        p = make_updated(&b, kinds[k], 1, 0);
        beam_fill(&b, now, 5e3, 0.45, mass);
        unwarped = iterations(&b, p, tolerance);
        CHECK_OK(sb_preconditioner_warp(p, &b.a, rotations, now, NULL));
        warped = iterations(&b, p, tolerance);
        if (!CHECK(current > 20 && warped > 0 && warped <= current + current / 10) ||
            !CHECK(unwarped == 0 || unwarped > (kinds[k] == SB_PRECOND_BLOCK_JACOBI ? 1 : 2) * current))
            printf("    kind %d: current %d, warped %d, unwarped %d\n", (int)kinds[k], current, warped, unwarped);
        sb_preconditioner_free(p);
    }
    free(now);
    free(rotations);
    beam_free(&b);
}

/* A complete factor made at rest, turned, leaves little to do. */
static void test_bent_factor(void)
{
    const double length = 0.3;
    beam b = beam_make(25, 5, length, 0);
    sb_vec3 *now = bent_nodes(&b.mesh, length);
    sb_quat *rotations = rotations_of(&b.mesh, now);
    const double mass = 1000 / (0.01 * 0.01);
    for (int pieces = 0; pieces <= 8; pieces += 8) {
        sb_preconditioner *p;
        int unwarped, warped;
        beam_fill(&b, b.mesh.nodes, 5e3, 0.45, mass);
        p = make_updated(&b, SB_PRECOND_CHOLESKY, 1, pieces);
        beam_fill(&b, now, 5e3, 0.45, mass);
        unwarped = iterations(&b, p, 1e-3);
        CHECK_OK(sb_preconditioner_warp(p, &b.a, rotations, now, NULL));
        warped = iterations(&b, p, 1e-3);
        if (!CHECK(warped > 0 && warped <= 12 && unwarped > 2 * warped))
            printf("    pieces %d: warped %d, unwarped %d\n", pieces, warped, unwarped);
        sb_preconditioner_free(p);
    }
    free(now);
    free(rotations);
    beam_free(&b);
}

/* A body that turned as a whole: M is the old one turned, exactly. */
static void test_turned_whole(void)
{
    beam b = beam_make(8, 2, 0.2, 0.1);
    sb_mat3 r = sb_quat_to_mat3(sb_quat_from_rotation_vector(sb_v3(REAL(0.7), REAL(-1.9), REAL(1.1))));
    sb_vec3 *now = (sb_vec3 *)malloc((size_t)b.n * sizeof(sb_vec3));
    sb_quat *rotations;
    for (int i = 0; i < b.n; i++)
        now[i] = sb_m3_apply(r, b.mesh.nodes[i]);
    rotations = rotations_of(&b.mesh, now);
    for (int i = 0; i < b.n; i++) {
        sb_mat3 got = sb_quat_to_mat3(rotations[i]);
        for (int k = 0; k < 9; k++)
            CHECK_NEAR(got.m[k / 3][k % 3], (double)r.m[k / 3][k % 3], scene_tolerance(1e-12, 100));
    }
    for (int kind = SB_PRECOND_BLOCK_JACOBI; kind <= SB_PRECOND_CHOLESKY; kind++) {
        sb_preconditioner *p;
        sb_real *in = random_vector(3 * b.n, 3), *turned = random_vector(3 * b.n, 3), *out = random_vector(3 * b.n, 4);
        double *expected = (double *)malloc(3 * (size_t)b.n * sizeof(double));
        beam_fill(&b, b.mesh.nodes, 5e3, 0.45, 1e4);
        p = make_updated(&b, (sb_precond_kind)kind, 1, 0);
        for (int i = 0; i < b.n; i++)
            for (int k = 0; b.mask[i] && k < 3; k++)
                in[3 * i + k] = 0;
        sb_preconditioner_apply(p, in, out);
        for (int i = 0; i < b.n; i++) {
            sb_vec3 v = sb_m3_apply(r, sb_v3(in[3 * i], in[3 * i + 1], in[3 * i + 2]));
            sb_vec3 z = sb_m3_apply(r, sb_v3(out[3 * i], out[3 * i + 1], out[3 * i + 2]));
            turned[3 * i] = v.x, turned[3 * i + 1] = v.y, turned[3 * i + 2] = v.z;
            expected[3 * i] = (double)z.x, expected[3 * i + 1] = (double)z.y, expected[3 * i + 2] = (double)z.z;
        }
        beam_fill(&b, now, 5e3, 0.45, 1e4);
        CHECK_OK(sb_preconditioner_warp(p, &b.a, rotations, NULL, NULL));
        sb_preconditioner_apply(p, turned, out);
        CHECK(largest_difference(out, expected, 3 * b.n) < 100 * SINGLE);
        CHECK_OK(sb_preconditioner_warp(p, &b.a, NULL, NULL, NULL)); /* and back */
        sb_preconditioner_apply(p, in, turned);
        for (int i = 0; i < b.n; i++) {
            sb_vec3 z = sb_m3_apply(r, sb_v3(turned[3 * i], turned[3 * i + 1], turned[3 * i + 2]));
            CHECK_NEAR(z.y, expected[3 * i + 1], 100 * SINGLE * (fabs(expected[3 * i + 1]) + 1));
        }
        sb_preconditioner_free(p);
        free(in);
        free(turned);
        free(out);
        free(expected);
    }
    free(now);
    free(rotations);
    beam_free(&b);
}

/* u.Mv = v.Mu and u.Mu > 0 with rotations of any kind and supports that hold single axes; a prescribed component is
 * left to itself. */
static void test_symmetric(void)
{
    beam b = beam_make(8, 3, 0.2, 0.1);
    sb_quat *rotations = (sb_quat *)malloc((size_t)b.n * sizeof(sb_quat));
    unsigned long long seed = 77;
    for (int i = 0; i < b.n; i++)
        rotations[i] =
            sb_quat_from_rotation_vector(sb_v3(REAL(check_random_in(&seed, -3, 3)), REAL(check_random_in(&seed, -3, 3)),
                                               REAL(check_random_in(&seed, -3, 3))));
    for (int kind = SB_PRECOND_BLOCK_JACOBI; kind <= SB_PRECOND_CHOLESKY; kind++) {
        sb_preconditioner *p = make_updated(&b, (sb_precond_kind)kind, 1, 0);
        sb_real *u = random_vector(3 * b.n, 21), *v = random_vector(3 * b.n, 22), *mu = random_vector(3 * b.n, 1);
        sb_real *mv = random_vector(3 * b.n, 2);
        double uv = 0, vu = 0, uu = 0;
        int slider = b.n - 1;
        b.mask[slider] = SB_Y;
        beam_fill(&b, b.mesh.nodes, 5e3, 0.45, 1e5);
        CHECK_OK(sb_preconditioner_warp(p, &b.a, rotations, NULL, NULL));
        sb_preconditioner_apply(p, u, mu);
        sb_preconditioner_apply(p, v, mv);
        for (int i = 0; i < 3 * b.n; i++) {
            uv += (double)u[i] * (double)mv[i];
            vu += (double)v[i] * (double)mu[i];
            uu += (double)u[i] * (double)mu[i];
        }
        CHECK(uu > 0);
        CHECK_NEAR(uv / uu, vu / uu, 100 * SINGLE);
        CHECK_NEAR((double)mu[3 * slider + 1] * (double)b.a.blocks[b.a.diagonal[slider]][4], (double)u[3 * slider + 1],
                   20 * SINGLE);
        b.mask[slider] = 0;
        beam_fill(&b, b.mesh.nodes, 5e3, 0.45, 1e5);
        sb_preconditioner_free(p);
        free(u);
        free(v);
        free(mu);
        free(mv);
    }
    free(rotations);
    beam_free(&b);
}

/* Stretch does not turn, nodes without elements do not either, and size does not matter. */
static void test_nodal_rotations(void)
{
    const sb_element_type types[3] = {SB_TET4, SB_TET10, SB_HEX8};
    for (int t = 0; t < 3; t++)
        for (int s = -1; s <= 1; s++) {
            double scale = pow(1e3, s), angle = 2.5;
            sb_mesh mesh = scene_box(types[t], 3, 2, 2, sb_v3(REAL(3 * scale), REAL(scale), REAL(scale)), 0.1);
            sb_mat3 turn = sb_quat_to_mat3(sb_quat_from_rotation_vector(sb_v3(0, 0, REAL(angle))));
            sb_vec3 *now = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
            sb_quat *rotations;
            for (int i = 0; i < mesh.node_count; i++)
                now[i] = sb_m3_apply(turn, sb_v3(2 * mesh.nodes[i].x, REAL(0.5) * mesh.nodes[i].y, mesh.nodes[i].z));
            rotations = rotations_of(&mesh, now);
            for (int i = 0; i < mesh.node_count; i++) {
                double sign = rotations[i].w < 0 ? -1 : 1;
                CHECK_NEAR(sign * (double)rotations[i].w, cos(angle / 2), scene_tolerance(1e-12, 200));
                CHECK_NEAR(sign * (double)rotations[i].z, sin(angle / 2), scene_tolerance(1e-12, 200));
            }
            free(now);
            free(rotations);
            sb_mesh_free(&mesh);
        }
}

/* ---- threads ---- */

/* Hash of an application after an update and after a warp. */
static unsigned long long applied(const beam *b, sb_precond_kind kind, int workers, const sb_quat *rotations)
{
    sb_preconditioner_def def = sb_default_preconditioner_def();
    sb_preconditioner *p = NULL;
    sb_real *r = random_vector(3 * b->n, 31), *z = random_vector(3 * b->n, 32);
    unsigned long long hash;
    def.kind = kind;
    def.positions = b->mesh.nodes;
    def.piece_count = 5;
    def.power = 2;
    if (workers)
        def.jobs = scene_jobs(&workers);
    CHECK_OK(sb_preconditioner_create(&def, &b->a, NULL, &p, NULL));
    CHECK_OK(sb_preconditioner_update(p, &b->a, NULL, NULL));
    sb_preconditioner_apply(p, r, z);
    hash = scene_hash(z, 3 * (size_t)b->n * sizeof(sb_real));
    CHECK_OK(sb_preconditioner_warp(p, &b->a, rotations, b->mesh.nodes, NULL));
    sb_preconditioner_apply(p, r, z);
    hash = hash * 31 + scene_hash(z, 3 * (size_t)b->n * sizeof(sb_real));
    sb_preconditioner_free(p);
    free(r);
    free(z);
    return hash;
}

static void test_threads(void)
{
    beam b = beam_make(30, 6, 0.2, 0.1);
    sb_quat *rotations = (sb_quat *)malloc((size_t)b.n * sizeof(sb_quat));
    for (int i = 0; i < b.n; i++)
        rotations[i] = sb_quat_from_rotation_vector(sb_v3(0, REAL(0.01 * i), 0));
    for (int kind = SB_PRECOND_BLOCK_JACOBI; kind <= SB_PRECOND_CHOLESKY; kind++) {
        unsigned long long alone = applied(&b, (sb_precond_kind)kind, 0, rotations);
        for (int workers = 1; workers <= 7; workers += 1 + workers / 3 * 3)
            CHECK(applied(&b, (sb_precond_kind)kind, workers, rotations) == alone);
    }
    free(rotations);
    beam_free(&b);
}

/* The same bits from every compiler, with and without vectors. */
static void test_golden(void)
{
    beam b = beam_make(12, 3, 0.2, 0.1), halved = beam_make(30, 6, 0.2, 0.1);
    sb_quat *rotations = (sb_quat *)malloc((size_t)halved.n * sizeof(sb_quat));
    unsigned long long hash;
    for (int i = 0; i < halved.n; i++)
        rotations[i] = sb_quat_from_rotation_vector(sb_v3(0, REAL(0.01 * i), 0));
    hash = applied(&b, SB_PRECOND_FSAI, 0, rotations);
    hash = hash * 31 + applied(&b, SB_PRECOND_CHOLESKY, 0, rotations);
    hash = hash * 31 + applied(&halved, SB_PRECOND_IC0, 0, rotations);
    if (!CHECK(hash == (SB_REAL_IS_FLOAT ? 0xb63c7fa1d1df79b1ULL : 0x0b8a668562d03dfbULL)))
        printf("hash %llx\n", hash);
    free(rotations);
    beam_free(&b);
    beam_free(&halved);
}

/* ---- saved bytes ---- */

/* Both give the same bits, as they are and turned. */
static void check_same(sb_preconditioner *p, sb_preconditioner *other, const beam *b)
{
    sb_quat *rotations = (sb_quat *)malloc((size_t)b->n * sizeof(sb_quat));
    sb_real *r = random_vector(3 * b->n, 51), *z = random_vector(3 * b->n, 52), *again = random_vector(3 * b->n, 53);
    for (int i = 0; i < b->n; i++)
        rotations[i] = sb_quat_from_rotation_vector(sb_v3(0, REAL(0.01 * i), 0));
    for (int turned = 0; turned < 2; turned++) {
        CHECK_OK(sb_preconditioner_warp(p, &b->a, turned ? rotations : NULL, NULL, NULL));
        CHECK_OK(sb_preconditioner_warp(other, &b->a, turned ? rotations : NULL, NULL, NULL));
        sb_preconditioner_apply(p, r, z);
        sb_preconditioner_apply(other, r, again);
        CHECK(memcmp(z, again, 3 * (size_t)b->n * sizeof(sb_real)) == 0);
    }
    free(rotations);
    free(r);
    free(z);
    free(again);
}

static void test_saved(void)
{
    beam b = beam_make(12, 3, 0.2, 0.1);
    for (int kind = SB_PRECOND_NONE; kind <= SB_PRECOND_CHOLESKY; kind++)
        for (int pieces = 0; pieces <= 4; pieces += 4) {
            sb_preconditioner *p = make_updated(&b, (sb_precond_kind)kind, 2, pieces);
            sb_preconditioner *other = make(&b.a, (sb_precond_kind)kind, 2, b.mesh.nodes, pieces);
            size_t size = sb_preconditioner_saved_size(p);
            unsigned char *image = (unsigned char *)malloc(size + 1);
            image[size] = 99;
            CHECK_RESULT(sb_preconditioner_save(p, image, size - 1), SB_ERROR_ARGUMENT);
            CHECK_RESULT(sb_preconditioner_save(other, image, size), SB_ERROR_ARGUMENT);
            CHECK_OK(sb_preconditioner_save(p, image, size));
            CHECK_INT(image[size], 99);
            CHECK_OK(sb_preconditioner_load(other, image, size, NULL));
            CHECK(sb_preconditioner_get_info(other).shift == sb_preconditioner_get_info(p).shift);
            for (int k = 0; kind == SB_PRECOND_IC0 && k < 20; k++) { /* until both try a smaller one */
                CHECK_OK(sb_preconditioner_update(p, &b.a, NULL, NULL));
                CHECK_OK(sb_preconditioner_update(other, &b.a, NULL, NULL));
                CHECK(sb_preconditioner_get_info(other).shift == sb_preconditioner_get_info(p).shift);
                CHECK_INT(sb_preconditioner_get_info(other).attempts, sb_preconditioner_get_info(p).attempts);
            }
            check_same(p, other, &b);
            sb_preconditioner_free(p);
            sb_preconditioner_free(other);
            free(image);
        }
    beam_free(&b);
}

/* A factor in two halves serves those with the same order only. */
static void test_saved_halves(void)
{
    beam b = beam_make(30, 6, 0.2, 0.1);
    sb_preconditioner *p = make_updated(&b, SB_PRECOND_IC0, 1, 8), *natural = make_updated(&b, SB_PRECOND_IC0, 1, 0);
    sb_preconditioner *other = make(&b.a, SB_PRECOND_IC0, 1, b.mesh.nodes, 8);
    size_t size = sb_preconditioner_saved_size(p);
    void *image = malloc(size);
    sb_error error;
    CHECK_OK(sb_preconditioner_save(p, image, size));
    CHECK_RESULT(sb_preconditioner_load(natural, image, size, &error), SB_ERROR_STATE);
    CHECK(strstr(error.message, "half") != NULL);
    CHECK_OK(sb_preconditioner_load(other, image, size, NULL));
    check_same(p, other, &b);
    CHECK_OK(sb_preconditioner_save(natural, image, size));
    CHECK_RESULT(sb_preconditioner_load(p, image, size, &error), SB_ERROR_STATE);
    sb_preconditioner_free(p);
    sb_preconditioner_free(natural);
    sb_preconditioner_free(other);
    free(image);
    beam_free(&b);
}

/* Loads an image that must be refused, and looks that nothing changed. */
static void check_refused(sb_preconditioner *p, const unsigned char *image, size_t size, sb_result expected,
                          const beam *b)
{
    sb_real *r = random_vector(3 * b->n, 61), *before = random_vector(3 * b->n, 62);
    sb_real *after = random_vector(3 * b->n, 63);
    sb_error error;
    sb_preconditioner_apply(p, r, before);
    CHECK_RESULT(sb_preconditioner_load(p, image, size, &error), expected);
    CHECK(error.result == expected && error.message[0]);
    sb_preconditioner_apply(p, r, after);
    CHECK(memcmp(before, after, 3 * (size_t)b->n * sizeof(sb_real)) == 0);
    free(r);
    free(before);
    free(after);
}

enum { IMAGE_HEAD = 24, IMAGE_NUMBERS = IMAGE_HEAD + 6 * 8, IMAGE_VALUES = IMAGE_NUMBERS + 8 + 8 + 4 + 4 };

static void test_damaged(void)
{
    const sb_precond_kind kinds[4] = {SB_PRECOND_FSAI, SB_PRECOND_IC0, SB_PRECOND_CHOLESKY, SB_PRECOND_SSOR};
    beam b = beam_make(4, 1, 0.2, 0.1);
    check_bad_numbers();
    for (int k = 0; k < 4; k++) {
        sb_preconditioner *p = make_updated(&b, kinds[k], 1, 2);
        size_t size = sb_preconditioner_saved_size(p);
        unsigned char *image = (unsigned char *)malloc(size), *forged = (unsigned char *)malloc(size + 8);
        unsigned long long seed = 5;
        CHECK_OK(sb_preconditioner_save(p, image, size));
        for (size_t at = 0; at < size; at += 1 + (size_t)(check_random_in(&seed, 0, 1) * 40)) { /* a flipped bit */
            sb_error error;
            memcpy(forged, image, size);
            forged[at] ^= (unsigned char)(1u << at % 8);
            CHECK(sb_preconditioner_load(p, forged, size, &error) != SB_OK && error.message[0]);
        }
        check_refused(p, image, 0, SB_ERROR_FORMAT, &b);
        check_refused(p, image, size - 1, SB_ERROR_FORMAT, &b);
        memcpy(forged, image, size);
        forged[8] = 3;
        check_refused(p, forged, size, SB_ERROR_UNSUPPORTED, &b);
        for (size_t word = 0; word < 6; word++) { /* another make */
            memcpy(forged, image, size);
            forged[IMAGE_HEAD + 8 * word] ^= 1;
            image_seal(forged, size);
            check_refused(p, forged, size, SB_ERROR_STATE, &b);
        }
        memcpy(forged, image, size); /* a scale that is no power of two; a shift of nothing; a negative wait */
        image_put(forged + IMAGE_NUMBERS, 0x3FF8000000000000u, 8);
        image_seal(forged, size);
        check_refused(p, forged, size, SB_ERROR_FORMAT, &b);
        memcpy(forged, image, size);
        image_put(forged + IMAGE_NUMBERS + 8, 0x7FF8000000000000u, 8);
        image_seal(forged, size);
        check_refused(p, forged, size, SB_ERROR_FORMAT, &b);
        memcpy(forged, image, size);
        image_put(forged + IMAGE_NUMBERS + 20, 0xFFFFFFFFu, 4);
        image_seal(forged, size);
        check_refused(p, forged, size, SB_ERROR_FORMAT, &b);
        memcpy(forged, image, size); /* a number that is none, of floats and of reals */
        image_put(forged + size - 16, 0x7FF000007FC00000u, 8);
        image_seal(forged, size);
        check_refused(p, forged, size, SB_ERROR_NOT_FINITE, &b);
        memcpy(forged, image, size - 8); /* more than there should be, and less */
        memset(forged + size - 8, 0, 16);
        image_seal(forged, size + 8);
        check_refused(p, forged, size + 8, SB_ERROR_FORMAT, &b);
        memcpy(forged, image, size - 12);
        image_seal(forged, size - 4);
        check_refused(p, forged, size - 4, SB_ERROR_FORMAT, &b);
        memcpy(forged, image, size); /* what makes it definite */
        image_put(forged + IMAGE_VALUES, 0xBF800000u, 4);
        image_seal(forged, size);
        if (kinds[k] != SB_PRECOND_CHOLESKY)
            check_refused(p, forged, size, SB_ERROR_FORMAT, &b);
        sb_preconditioner_free(p);
        free(image);
        free(forged);
    }
    beam_free(&b);
}

/* ---- bodies ---- */

/* Displacements of a falling cantilever after some steps. */
static sb_vec3 *played(sb_precond_kind kind, int workers, int *count)
{
    sb_mesh mesh = scene_box(SB_TET4, 8, 3, 3, sb_v3(REAL(0.2), REAL(0.06), REAL(0.06)), 0.1);
    sb_body_def def = sb_default_body_def();
    sb_vec3 *end = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_corotated(5000, REAL(0.45), 1000);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.preconditioner = kind;
    def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-3 : 1e-9);
    if (workers)
        def.jobs = scene_jobs(&workers);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int k = 0; k < 8; k++)
        CHECK_OK(sb_body_step(body, REAL(0.02), NULL));
    memcpy(end, sb_body_displacements(body), (size_t)mesh.node_count * sizeof(sb_vec3));
    *count = mesh.node_count;
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return end;
}

/* A body may have any of them, with any number of threads. */
static void test_bodies(void)
{
    const sb_precond_kind kinds[2] = {SB_PRECOND_FSAI, SB_PRECOND_CHOLESKY};
    int n = 0;
    sb_vec3 *usual = played(SB_PRECOND_IC0, 0, &n), zero = sb_v3(0, 0, 0);
    double size = 0;
    for (int i = 0; i < n; i++)
        size = fmax(size, scene_distance(usual + i, &zero, 1));
    CHECK(size > 1e-3);
    for (int k = 0; k < 2; k++) {
        sb_vec3 *alone = played(kinds[k], 0, &n), *shared = played(kinds[k], 3, &n);
        CHECK(scene_distance(alone, usual, n) < (SB_REAL_IS_FLOAT ? 3e-2 : 1e-6) * size);
        CHECK(memcmp(alone, shared, (size_t)n * sizeof(sb_vec3)) == 0);
        free(alone);
        free(shared);
    }
    free(usual);
}

/* ---- ways to fail ---- */

static void test_bad_arguments(void)
{
    beam b = beam_make(3, 1, 0.2, 0), other = beam_make(4, 1, 0.2, 0);
    sb_preconditioner_def def = sb_default_preconditioner_def();
    sb_preconditioner *p = NULL, *foreign = make_updated(&other, SB_PRECOND_FSAI, 1, 0);
    sb_quat *rotations = (sb_quat *)malloc((size_t)other.n * sizeof(sb_quat));
    unsigned char *image = (unsigned char *)malloc(sb_preconditioner_saved_size(foreign));
    sb_error error;
    CHECK(def.power == 1 && !def.jobs.run);
    def.kind = SB_PRECOND_FSAI;
    for (int power = -1; power <= 4; power += power == 0 ? 4 : 1) {
        def.power = power;
        CHECK_RESULT(sb_preconditioner_create(&def, &b.a, NULL, &p, &error), SB_ERROR_ARGUMENT);
    }
    def.power = 1;
    check_bad_numbers();
    for (int k = 0; k < 3; k++) {
        const sb_real outside[3] = {REAL(-1.01), REAL(0.51), REAL(NAN)};
        def.poisson = outside[k];
        CHECK_RESULT(sb_preconditioner_create(&def, &b.a, NULL, &p, &error), SB_ERROR_ARGUMENT);
    }
    def.poisson = 0;
    def.kind = SB_PRECOND_MULTIGRID; /* without positions */
    CHECK_RESULT(sb_preconditioner_create(&def, &b.a, NULL, &p, &error), SB_ERROR_ARGUMENT);
    CHECK(p == NULL);
    p = make(&b.a, SB_PRECOND_FSAI, 1, b.mesh.nodes, 2);
    for (int i = 0; i < other.n; i++)
        rotations[i] = sb_quat_identity();
    CHECK_RESULT(sb_preconditioner_warp(p, &b.a, rotations, NULL, &error), SB_ERROR_ARGUMENT); /* never updated */
    CHECK_OK(sb_preconditioner_update(p, &b.a, NULL, NULL));
    CHECK_RESULT(sb_preconditioner_warp(NULL, &b.a, rotations, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_preconditioner_warp(p, NULL, rotations, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_preconditioner_warp(p, &other.a, rotations, NULL, &error), SB_ERROR_ARGUMENT);
    rotations[5].w = REAL(NAN);
    CHECK_RESULT(sb_preconditioner_warp(p, &b.a, rotations, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_INT(error.node, 5);
    rotations[5].w = 0;
    CHECK_RESULT(sb_preconditioner_warp(p, &b.a, rotations, NULL, &error), SB_ERROR_ARGUMENT);
    rotations[5] = sb_quat_identity();
    CHECK_OK(sb_preconditioner_save(foreign, image, sb_preconditioner_saved_size(foreign)));
    check_refused(p, image, sb_preconditioner_saved_size(foreign), SB_ERROR_STATE, &b);
    CHECK_RESULT(sb_preconditioner_load(p, NULL, 0, &error), SB_ERROR_ARGUMENT);
    sb_preconditioner_free(p);
    p = make_updated(&b, SB_PRECOND_MULTIGRID, 1, 0); /* cheap to make: neither turned nor kept */
    CHECK_RESULT(sb_preconditioner_warp(p, &b.a, rotations, NULL, &error), SB_ERROR_UNSUPPORTED);
    CHECK(sb_preconditioner_saved_size(p) == 0);
    CHECK_RESULT(sb_preconditioner_save(p, image, 1000), SB_ERROR_UNSUPPORTED);
    CHECK_RESULT(sb_preconditioner_load(p, image, sb_preconditioner_saved_size(foreign), &error), SB_ERROR_UNSUPPORTED);
    CHECK_RESULT(sb_preconditioner_load(NULL, image, 8, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_preconditioner_save(NULL, image, 8), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_preconditioner_save(p, NULL, 8), SB_ERROR_ARGUMENT);
    sb_preconditioner_free(p);
    sb_preconditioner_free(foreign);
    free(rotations);
    free(image);
    beam_free(&b);
    beam_free(&other);
}

/* Every allocation failing in turn; nothing is taken after creation. */
static void test_failing_memory(void)
{
    beam b = beam_make(4, 2, 0.2, 0);
    const sb_precond_kind kinds[2] = {SB_PRECOND_FSAI, SB_PRECOND_CHOLESKY};
    for (int k = 0; k < 2; k++) {
        int failures = 0, done = 0;
        for (int n = 1; n < 100 && !done; n++) {
            scene_memory memory = {0, 0, 0, 0};
            sb_allocator allocator = scene_allocator(&memory);
            sb_preconditioner_def def = sb_default_preconditioner_def();
            sb_preconditioner *p = NULL;
            sb_error error;
            memory.fail_at = n;
            def.kind = kinds[k];
            def.power = 2;
            def.positions = b.mesh.nodes;
            def.piece_count = 2;
            if (sb_preconditioner_create(&def, &b.a, &allocator, &p, &error) == SB_OK) {
                int calls = memory.calls;
                size_t size = sb_preconditioner_saved_size(p);
                unsigned char *image = (unsigned char *)malloc(size);
                CHECK_OK(sb_preconditioner_update(p, &b.a, b.mesh.nodes, &error));
                CHECK_OK(sb_preconditioner_save(p, image, size));
                CHECK_OK(sb_preconditioner_load(p, image, size, &error));
                CHECK_OK(sb_preconditioner_warp(p, &b.a, NULL, b.mesh.nodes, &error));
                CHECK(iterations(&b, p, 1e-3) > 0);
                CHECK_INT(memory.calls, calls);
                free(image);
                done = 1;
            } else {
                failures++;
                CHECK_INT(error.result, SB_ERROR_MEMORY);
                CHECK(p == NULL);
            }
            sb_preconditioner_free(p);
            CHECK_INT(memory.live, 0);
        }
        CHECK(done);
        CHECK(failures > 10);
    }
    beam_free(&b);
}

/* ---- entries that floats do not have ---- */

/* Nodes of next to no mass, as crumbs of cut tissue are: their inverses are beyond floats. */
static void test_crumbs(void)
{
    static const sb_precond_kind kinds[] = {SB_PRECOND_BLOCK_JACOBI, SB_PRECOND_SSOR, SB_PRECOND_IC0, SB_PRECOND_FSAI};
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(1, 1, 1), 0);
    sb_matrix a;
    size_t n = (size_t)mesh.node_count;
    sb_vec3 *r = (sb_vec3 *)calloc(2 * n, sizeof *r), *z = r + n;
    CHECK_OK(sb_matrix_create(mesh.node_count, mesh.element_count, 4, NULL, mesh.elements, NULL, &a, NULL));
    for (int i = 0; i < mesh.node_count; i++) {
        double mass = i % 3 == 0 ? pow(10, -i) * 1e-8 : 1;
        sb_real *block = a.blocks[a.diagonal[i]];
        block[0] = block[4] = block[8] = REAL(mass);
        r[i] = sb_v3(REAL(mass), REAL(-mass), REAL(mass));
    }
    for (int k = 0; k < 4; k++) {
        sb_preconditioner *p = make(&a, kinds[k], 1, mesh.nodes, 0);
        sb_error error;
        if (!p || !CHECK_OK(sb_preconditioner_update(p, &a, NULL, &error)))
            continue;
        sb_preconditioner_apply(p, &r[0].x, &z[0].x);
        for (int i = 0; i < mesh.node_count; i++) {
            CHECK(sb_v3_is_finite(z[i]) && z[i].x >= 0 && z[i].x < 2);
            CHECK(i % 3 == 0 || z[i].x > REAL(0.1));
        }
        sb_preconditioner_free(p);
    }
    free(r);
    sb_matrix_free(&a);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(precond, {"FSAI equals dense", test_fsai_dense}, {"FSAI is complete within reach", test_fsai_complete},
            {"FSAI of one node", test_fsai_one_node}, {"FSAI shift", test_fsai_shift},
            {"iteration counts", test_iteration_counts}, {"scales", test_scales}, {"bent beam", test_bent_beam},
            {"bent factor", test_bent_factor}, {"turned as a whole", test_turned_whole},
            {"symmetric with rotations", test_symmetric}, {"nodal rotations", test_nodal_rotations},
            {"threads", test_threads}, {"golden inverses", test_golden}, {"saved and loaded", test_saved},
            {"crumbs", test_crumbs}, {"saved halves", test_saved_halves}, {"damaged images", test_damaged},
            {"bodies", test_bodies}, {"bad arguments", test_bad_arguments}, {"failing memory", test_failing_memory});
