/* Rows with lines: a mapping's or a potential's stiffness k [(1 - l.l) I + l l^T] stands in the matrix, in the product
 * without it, in the forces and in the work along a line. All four against one formula, for random rows. Lines are
 * internal. */
#define SB_SPLIT_BUILD
#include "../src/softbody/body/body_guest.h"
#include "../src/softbody/body/body_private.h"
#include "../src/softbody/body/load.h"

#include "check.h"
#include "random_case.h"

enum { ROWS = 24, MAX_ROW_NODES = 12 };

typedef struct random_rows {
    int start[ROWS + 1], nodes[ROWS * MAX_ROW_NODES];
    sb_real weights[ROWS * MAX_ROW_NODES], stiffness[ROWS];
    sb_vec3 lines[ROWS], points[ROWS];
} random_rows;

static sb_vec3 random_vector(unsigned long long *seed)
{
    return sb_v3(REAL(check_random_in(seed, -1, 1)), REAL(check_random_in(seed, -1, 1)),
                 REAL(check_random_in(seed, -1, 1)));
}

/* Of length 0, of some length below 1, and of length 1. */
static sb_vec3 random_line(unsigned long long *seed)
{
    int kind = random_below(seed, 3);
    return sb_v3_scale(kind == 1 ? REAL(check_random(seed)) : REAL(kind / 2), random_direction(seed));
}

/* A row in four has none. */
static void random_stiffness(unsigned long long *seed, sb_real *stiffness)
{
    for (int j = 0; j < ROWS; j++)
        stiffness[j] = random_below(seed, 4) ? REAL(random_scale(seed, 1, 1e4)) : 0;
}

/* Rows of 1 to 12 nodes, some of them twice; in_elements: each of nodes of one element. */
static void make_rows(unsigned long long *seed, const sb_mesh *mesh, int in_elements, random_rows *rows)
{
    int element_nodes = sb_element_node_count(mesh->element_type);
    rows->start[0] = 0;
    for (int j = 0; j < ROWS; j++) {
        const int *element = mesh->elements + random_below(seed, mesh->element_count) * element_nodes;
        rows->start[j + 1] = rows->start[j] + 1 + random_below(seed, MAX_ROW_NODES);
        for (int k = rows->start[j]; k < rows->start[j + 1]; k++) {
            rows->nodes[k] =
                in_elements ? element[random_below(seed, element_nodes)] : random_below(seed, mesh->node_count);
            rows->weights[k] = REAL(check_random_in(seed, -1, 1));
        }
        rows->lines[j] = random_line(seed);
        rows->points[j] = random_vector(seed);
    }
    random_stiffness(seed, rows->stiffness);
}

static sb_mapping mapping_of(const random_rows *rows)
{
    sb_mapping mapping = {ROWS, rows->start, rows->nodes, rows->weights};
    return mapping;
}

/* ---- what is expected ---- */

/* What a row pulls with at x, in double: k along its line, (1 - l.l) k across it. */
static void row_pull(const random_rows *rows, int row, int has_line, double k, const sb_vec3 *x, double pull[3])
{
    const sb_vec3 line = has_line ? rows->lines[row] : sb_v3(0, 0, 0);
    const double l[3] = {(double)line.x, (double)line.y, (double)line.z};
    double squared = l[0] * l[0] + l[1] * l[1] + l[2] * l[2], v[3] = {0, 0, 0}, share;
    for (int i = rows->start[row]; i < rows->start[row + 1]; i++) {
        v[0] += (double)rows->weights[i] * (double)x[rows->nodes[i]].x;
        v[1] += (double)rows->weights[i] * (double)x[rows->nodes[i]].y;
        v[2] += (double)rows->weights[i] * (double)x[rows->nodes[i]].z;
    }
    share = squared > 0 ? (l[0] * v[0] + l[1] * v[1] + l[2] * v[2]) / squared : 0;
    for (int c = 0; c < 3; c++) {
        double along = share * l[c];
        pull[c] = k * (along + (1 - squared) * (v[c] - along));
    }
}

/* At each node: K x, and what its rounding errors are a share of. */
typedef struct row_sums {
    double (*product)[3];
    double *size;
} row_sums;

/* Of rows of stiffness k, which comes from numbers up to `most`. */
static void add_expected(const random_rows *rows, int has_lines, const double *k, const double *most, const sb_vec3 *x,
                         row_sums *sums)
{
    const double reach = 4; /* no displacement or target is larger */
    for (int j = 0; j < ROWS; j++) {
        double pull[3], weight = 1;
        row_pull(rows, j, has_lines, k[j], x, pull);
        for (int i = rows->start[j]; i < rows->start[j + 1]; i++)
            weight += fabs((double)rows->weights[i]);
        for (int i = rows->start[j]; i < rows->start[j + 1]; i++) {
            for (int c = 0; c < 3; c++)
                sums->product[rows->nodes[i]][c] += (double)rows->weights[i] * pull[c];
            sums->size[rows->nodes[i]] += fabs((double)rows->weights[i]) * most[j] * weight * reach;
        }
    }
}

/* sign * y is K x at each node, to rounding. */
static void check_product(const char *what, const row_sums *sums, const sb_vec3 *y, double sign, int count)
{
    double worst = 0;
    for (int i = 0; i < count; i++) {
        double off = fmax(
            fabs(sign * (double)y[i].x - sums->product[i][0]),
            fmax(fabs(sign * (double)y[i].y - sums->product[i][1]), fabs(sign * (double)y[i].z - sums->product[i][2])));
        worst = off > 0 && !(off <= worst * sums->size[i]) ? off / sums->size[i] : worst;
    }
    if (!CHECK(worst <= 4 * (double)SB_EPSILON))
        printf("    %s: off by %.3g of its size\n", what, worst);
}

/* ---- a body with all kinds of rows ---- */

/* Rows of a mapping with lines, of one that has lost them, and of a potential. */
typedef struct rows_scene {
    sb_mesh mesh;
    sb_body *body;
    random_rows lined, plain, outer;
    sb_real new_stiffness[ROWS]; /* of the first; rows->stiffness is that of the last static solve */
    sbi_potential *potential;
    int count; /* nodes */
} rows_scene;

static void fill_outer(void *user, const sb_vec3 *u, sb_vec3 *force, sb_real *stiffness, sb_vec3 *lines)
{
    const random_rows *rows = &((const rows_scene *)user)->outer;
    for (int j = 0; j < ROWS; j++) {
        double pull[3];
        row_pull(rows, j, 1, (double)rows->stiffness[j], u, pull);
        force[j] = sb_v3(REAL(-pull[0]), REAL(-pull[1]), REAL(-pull[2]));
        stiffness[j] = rows->stiffness[j];
        lines[j] = rows->lines[j];
    }
}

static int make_scene(unsigned long long *seed, sb_element_type type, rows_scene *s)
{
    const int nx = 1 + random_below(seed, 3), ny = 1 + random_below(seed, 3), nz = 1 + random_below(seed, 2);
    sb_body_def def = sb_default_body_def();
    sb_mapping lined, plain, outer;
    int lined_id = 0, plain_id = 0;
    s->mesh = scene_box(type, nx, ny, nz, sb_v3(1, 1, 1), 0.2);
    s->count = s->mesh.node_count;
    def.mesh = &s->mesh;
    def.material = sb_material_linear(1000, REAL(0.3), 1000);
    s->body = scene_body(&def);
    if (!s->body)
        return 0;
    make_rows(seed, &s->mesh, 0, &s->lined);
    make_rows(seed, &s->mesh, 0, &s->plain);
    make_rows(seed, &s->mesh, 1, &s->outer);
    random_stiffness(seed, s->new_stiffness);
    lined = mapping_of(&s->lined), plain = mapping_of(&s->plain), outer = mapping_of(&s->outer);
    CHECK_OK(sb_body_add_mapping(s->body, &plain, s->plain.stiffness, 0, s->plain.points, &plain_id, NULL));
    CHECK_OK(sb_body_add_mapping(s->body, &lined, s->lined.stiffness, 0, s->lined.points, &lined_id, NULL));
    CHECK_OK(sbi_body_set_mapping_lines(s->body, plain_id, s->plain.lines));
    CHECK_OK(sbi_body_set_mapping_lines(s->body, plain_id, NULL));
    CHECK_OK(sbi_body_set_mapping_lines(s->body, lined_id, s->lined.lines));
    sbi_loads_begin_static(s->body); /* from here on a factor is a share of the way to new values */
    CHECK_OK(sb_body_set_mapping_stiffness(s->body, lined_id, s->new_stiffness, 0));
    CHECK_OK(sbi_potential_create(s->body, &outer, fill_outer, s, sbi_body_allocator(s->body), &s->potential, NULL));
    return CHECK_OK(sbi_potential_lend(s->body, s->potential, NULL));
}

static void free_scene(rows_scene *s)
{
    if (s->potential) {
        sbi_potential_return(s->body, s->potential);
        sbi_potential_destroy(s->potential);
    }
    sb_body_destroy(s->body);
    sb_mesh_free(&s->mesh);
}

/* K x of all rows and its size at each node. */
static void expect_all(const rows_scene *s, double factor, const sb_vec3 *x, row_sums *sums)
{
    double lined[ROWS], most[ROWS], plain[ROWS], outer[ROWS];
    for (int j = 0; j < ROWS; j++) {
        double from = (double)s->lined.stiffness[j], to = (double)s->new_stiffness[j];
        lined[j] = from + factor * (to - from);
        most[j] = fmax(from, to);
        plain[j] = (double)s->plain.stiffness[j];
        outer[j] = (double)s->outer.stiffness[j];
    }
    memset(sums->product, 0, (size_t)s->count * sizeof *sums->product);
    memset(sums->size, 0, (size_t)s->count * sizeof *sums->size);
    add_expected(&s->lined, 1, lined, most, x, sums);
    add_expected(&s->plain, 0, plain, plain, x, sums);
    add_expected(&s->outer, 1, outer, outer, x, sums);
}

/* ---- what the library gives ---- */

static void forces_at(rows_scene *s, const sb_vec3 *u, const sb_vec3 *x, double step, double factor, sb_vec3 *forces)
{
    for (int i = 0; i < s->count; i++)
        forces[i] = sb_v3_madd(u[i], REAL(step), x[i]);
    sbi_loads_fill(s->body, forces);
    sbi_loads_force(s->body, forces, REAL(factor));
    memcpy(forces, s->body->follower, (size_t)s->count * sizeof *forces);
}

/* Everything that knows the rows' stiffness, at displacement u along x. */
static void check_stiffness(rows_scene *s, const sb_vec3 *u, const sb_vec3 *x, double factor)
{
    const size_t size = (size_t)s->count * sizeof(sb_vec3);
    sb_vec3 *ahead = (sb_vec3 *)malloc(size), *behind = (sb_vec3 *)malloc(size), *y = (sb_vec3 *)calloc(1, size);
    row_sums sums = {(double(*)[3])malloc((size_t)s->count * sizeof(double[3])),
                     (double *)malloc((size_t)s->count * sizeof(double))};
    sb_matrix *matrix = &s->body->matrix;
    double work = 0, work_size = 0;
    expect_all(s, factor, x, &sums);

    /* Forces are linear: their central difference over any step is exact but for rounding. */
    forces_at(s, u, x, 1, factor, ahead);
    forces_at(s, u, x, -1, factor, behind);
    for (int i = 0; i < s->count; i++)
        ahead[i] = sb_v3_scale(REAL(-0.5), sb_v3_sub(ahead[i], behind[i]));
    check_product("differences of forces", &sums, ahead, 1, s->count);

    sbi_loads_fill(s->body, u);
    sbi_loads_subtract_product(s->body, x, REAL(factor), y);
    check_product("product without a matrix", &sums, y, -1, s->count);

    sb_matrix_clear(matrix);
    sbi_loads_add_tangent(s->body, u, SB_TANGENT_QUASI, REAL(factor), matrix);
    sb_matrix_multiply(matrix, &x[0].x, &y[0].x, NULL);
    check_product("matrix", &sums, y, 1, s->count);
    CHECK(sb_matrix_asymmetry(matrix) <= 16 * SB_EPSILON);

    for (int i = 0; i < s->count; i++) {
        work -= 0.5 * (sums.product[i][0] * (double)x[i].x + sums.product[i][1] * (double)x[i].y +
                       sums.product[i][2] * (double)x[i].z);
        work_size += sums.size[i];
    }
    CHECK_NEAR(sbi_loads_line(s->body, u, x, REAL(factor)).quadratic, work, 16 * (double)SB_EPSILON * work_size);
    free(ahead), free(behind), free(y), free(sums.product), free(sums.size);
}

static void test_one_stiffness(void)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
    enum { TYPES = (int)(sizeof types / sizeof types[0]), CASES = 6 };
    unsigned long long seed = 17;
    for (int k = 0; k < TYPES * CASES && !check.failures; k++) {
        rows_scene *s = (rows_scene *)calloc(1, sizeof *s);
        if (make_scene(&seed, types[k % TYPES], s)) {
            sb_vec3 *u = (sb_vec3 *)malloc(2 * (size_t)s->count * sizeof *u), *x = u + s->count;
            for (int i = 0; i < 2 * s->count; i++)
                u[i] = random_vector(&seed);
            check_stiffness(s, u, x, 1);
            check_stiffness(s, u, x, check_random(&seed));
            free(u);
        }
        free_scene(s);
        free(s);
    }
}

CHECK_SUITE(load_rows, {"one stiffness in matrix, product, forces and work", test_one_stiffness});
