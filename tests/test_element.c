/* element: node orders, shape functions and quadrature against what they are defined by. */
#include "softbody.h"

#include "check.h"

static const sb_element_type element_types[] = {SB_TRI3, SB_TRI6,  SB_QUAD4, SB_QUAD8, SB_QUAD9,
                                                SB_TET4, SB_TET10, SB_HEX8,  SB_HEX20, SB_HEX27};
enum { ELEMENT_TYPES = (int)(sizeof element_types / sizeof element_types[0]), ELEMENT_SURFACES = 5 };

/* 1 for quads and hexes, whose parameters lie in [-1, 1]. */
static int element_is_box(sb_element_type type)
{
    return sb_element_corner_count(type) == 8 ||
           (sb_element_dimension(type) == 2 && sb_element_corner_count(type) == 4);
}

static double element_eps(double factor) { return factor * (double)SB_EPSILON; }

/* A random point of the parameter domain. */
static void element_random_point(sb_element_type type, unsigned long long *seed, sb_real xi[3])
{
    int box = element_is_box(type);
    double r[3], sum = 0;
    for (int k = 0; k < 3; k++) {
        r[k] = k < sb_element_dimension(type) ? check_random(seed) : 0;
        sum += r[k];
    }
    for (int k = 0; k < 3; k++)
        xi[k] = (sb_real)(box && k < sb_element_dimension(type) ? 2 * r[k] - 1 : (sum > 1 ? r[k] / sum : r[k]));
}

static void test_counts(void)
{
    static const int expected[ELEMENT_TYPES][5] = {
        {3, 3, 2, 0, 3}, {6, 3, 2, 0, 3},  {4, 4, 2, 0, 4},  {8, 4, 2, 0, 4},   {9, 4, 2, 0, 4},
        {4, 4, 3, 4, 6}, {10, 4, 3, 4, 6}, {8, 8, 3, 6, 12}, {20, 8, 3, 6, 12}, {27, 8, 3, 6, 12}};
    static const char *const names[ELEMENT_TYPES] = {"tri3", "tri6",  "quad4", "quad8", "quad9",
                                                     "tet4", "tet10", "hex8",  "hex20", "hex27"};
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        sb_element_type type = element_types[t];
        CHECK_INT(sb_element_node_count(type), expected[t][0]);
        CHECK_INT(sb_element_corner_count(type), expected[t][1]);
        CHECK_INT(sb_element_dimension(type), expected[t][2]);
        CHECK_INT(sb_element_face_count(type), expected[t][3]);
        CHECK_INT(sb_element_edge_count(type), expected[t][4]);
        CHECK(strcmp(sb_element_name(type), names[t]) == 0);
    }
}

static void test_unknown(void)
{
    static const int codes[] = {0, -1, 6, 9, 16, 1000000}, kinds[] = {-1, 4};
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS], xi[3] = {7, 7, 7};
    int nodes[SB_MAX_FACE_NODES] = {77, 77, 77};
    sb_element_type face_type = SB_HEX8;
    weights[0] = 7;
    for (size_t i = 0; i < sizeof codes / sizeof codes[0]; i++) {
        sb_element_type type = (sb_element_type)codes[i];
        CHECK_INT(sb_element_node_count(type), 0);
        CHECK_INT(sb_element_corner_count(type), 0);
        CHECK_INT(sb_element_dimension(type), 0);
        CHECK_INT(sb_element_face_count(type), 0);
        CHECK_INT(sb_element_edge_count(type), 0);
        CHECK_INT(sb_element_face(type, 0, nodes, &face_type), 0);
        CHECK_INT(sb_element_edge(type, 0, nodes), 0);
        CHECK_INT(sb_element_node_point(type, 0, xi), 0);
        CHECK_INT(sb_element_quadrature(type, SB_QUADRATURE_MASS, points, weights), 0);
        CHECK(strcmp(sb_element_name(type), "unknown") == 0);
    }
    CHECK_INT(sb_element_node_count(SB_CUSTOM), 0); /* without its table a custom element is just a volume */
    CHECK_INT(sb_element_dimension(SB_CUSTOM), 3);
    CHECK_INT(sb_element_face_count(SB_CUSTOM), 0);
    CHECK_INT(sb_element_edge_count(SB_CUSTOM), 0);
    CHECK_INT(sb_element_face(SB_CUSTOM, 0, nodes, &face_type), 0);
    CHECK_INT(sb_element_quadrature(SB_CUSTOM, SB_QUADRATURE_MASS, points, weights), 0);
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        sb_element_type type = element_types[t];
        CHECK_INT(sb_element_face(type, -1, nodes, &face_type), 0);
        CHECK_INT(sb_element_face(type, sb_element_face_count(type), nodes, &face_type), 0);
        CHECK_INT(sb_element_edge(type, -1, nodes), 0);
        CHECK_INT(sb_element_edge(type, sb_element_edge_count(type), nodes), 0);
        CHECK_INT(sb_element_node_point(type, -1, xi), 0);
        CHECK_INT(sb_element_node_point(type, sb_element_node_count(type), xi), 0);
        for (int k = 0; k < 2; k++)
            CHECK_INT(sb_element_quadrature(type, (sb_quadrature_kind)kinds[k], points, weights), 0);
        if (sb_element_dimension(type) == 3)
            CHECK_INT(sb_element_quadrature(type, SB_QUADRATURE_FACE, points, weights), 0);
    }
    CHECK(nodes[0] == 77 && face_type == SB_HEX8 && xi[0] == 7 && weights[0] == 7);
}

/* N_a(x_b) = 1 for a = b, else 0. */
static void test_kronecker(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        sb_element_type type = element_types[t];
        for (int b = 0; b < sb_element_node_count(type); b++) {
            sb_real xi[3], shape[SB_MAX_ELEMENT_NODES];
            CHECK_INT(sb_element_node_point(type, b, xi), 1);
            sb_element_shape(type, xi, shape, NULL);
            for (int a = 0; a < sb_element_node_count(type); a++)
                CHECK_NEAR(shape[a], a == b, element_eps(4));
        }
    }
}

/* sum N = 1, sum N x = xi, sum dN = 0, sum x dN = identity. */
static void test_completeness(void)
{
    unsigned long long seed = 1;
    for (int i = 0; i < 20 * ELEMENT_TYPES; i++) {
        sb_element_type type = element_types[i % ELEMENT_TYPES];
        sb_real xi[3], at[3], shape[SB_MAX_ELEMENT_NODES], gradient[SB_MAX_ELEMENT_NODES][3];
        double sum = 0, point[3] = {0, 0, 0}, slope[3] = {0, 0, 0}, map[3][3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
        int dimension = sb_element_dimension(type);
        element_random_point(type, &seed, xi);
        sb_element_shape(type, xi, shape, gradient);
        for (int a = 0; a < sb_element_node_count(type); a++) {
            sb_element_node_point(type, a, at);
            sum += (double)shape[a];
            for (int k = 0; k < 3; k++) {
                point[k] += (double)(shape[a] * at[k]);
                slope[k] += (double)gradient[a][k];
                for (int l = 0; l < 3; l++)
                    map[k][l] += (double)(at[k] * gradient[a][l]);
            }
        }
        CHECK_NEAR(sum, 1, element_eps(16));
        for (int k = 0; k < 3; k++) {
            CHECK_NEAR(point[k], xi[k], element_eps(16));
            CHECK_NEAR(slope[k], 0, element_eps(32));
            for (int l = 0; l < 3; l++)
                CHECK_NEAR(map[k][l], k == l && k < dimension, element_eps(32));
        }
    }
}

static void test_gradient_by_differences(void)
{
    unsigned long long seed = 2;
    double h = SB_REAL_IS_FLOAT ? 1.0 / 64 : 1.0 / 4096; /* shapes are at most quadratic along an axis: exact */
    for (int i = 0; i < 10 * ELEMENT_TYPES; i++) {
        sb_element_type type = element_types[i % ELEMENT_TYPES];
        sb_real xi[3], gradient[SB_MAX_ELEMENT_NODES][3], up[SB_MAX_ELEMENT_NODES], down[SB_MAX_ELEMENT_NODES];
        element_random_point(type, &seed, xi);
        sb_element_shape(type, xi, NULL, gradient);
        for (int k = 0; k < sb_element_dimension(type); k++) {
            sb_real keep = xi[k];
            xi[k] = keep + (sb_real)h;
            sb_element_shape(type, xi, up, NULL);
            xi[k] = keep - (sb_real)h;
            sb_element_shape(type, xi, down, NULL);
            xi[k] = keep;
            for (int a = 0; a < sb_element_node_count(type); a++)
                CHECK_NEAR(gradient[a][k], ((double)up[a] - (double)down[a]) / (2 * h), element_eps(16) / h);
        }
    }
}

static sb_vec3 element_node(sb_element_type type, int node)
{
    sb_real xi[3] = {0, 0, 0};
    sb_element_node_point(type, node, xi);
    return sb_v3(xi[0], xi[1], xi[2]);
}

static sb_vec3 element_middle(sb_vec3 a, sb_vec3 b) { return sb_v3_scale((sb_real)0.5, sb_v3_add(a, b)); }

static void test_edges(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        sb_element_type type = element_types[t];
        int corners = sb_element_corner_count(type), edges = sb_element_edge_count(type);
        int quadratic = sb_element_node_count(type) > corners, used[SB_MAX_ELEMENT_NODES] = {0}, edge[3];
        for (int i = 0; i < sb_element_edge_count(type); i++) {
            CHECK_INT(sb_element_edge(type, i, edge), quadratic ? 3 : 2);
            used[edge[0]]++, used[edge[1]]++;
            CHECK_INT(edge[2] >= 0, quadratic);
            if (quadratic) {
                sb_vec3 middle = element_middle(element_node(type, edge[0]), element_node(type, edge[1]));
                CHECK(sb_v3_norm(sb_v3_sub(element_node(type, edge[2]), middle)) == 0);
                used[edge[2]]++;
            }
        }
        for (int a = 0; a < sb_element_node_count(type); a++)
            CHECK_INT(used[a], a >= corners + edges ? 0 : (a >= corners ? 1 : sb_element_dimension(type)));
    }
}

/* Faces look outward, follow the edges, and each directed edge has exactly one opposite. */
static void test_faces(void)
{
    static const sb_element_type expected[] = {SB_TRI3, SB_TRI6, SB_QUAD4, SB_QUAD8, SB_QUAD9};
    for (int t = ELEMENT_SURFACES; t < ELEMENT_TYPES; t++) {
        sb_element_type type = element_types[t], face_type = SB_NO_ELEMENT;
        int directed[8][8] = {{0}}, nodes[SB_MAX_FACE_NODES];
        sb_vec3 centre = element_is_box(type) ? sb_v3(0, 0, 0) : sb_v3((sb_real)0.25, (sb_real)0.25, (sb_real)0.25);
        for (int f = 0; f < sb_element_face_count(type); f++) {
            int count = sb_element_face(type, f, nodes, &face_type), corners, edge[3];
            sb_vec3 x0, x1, x2;
            CHECK_INT(count, sb_element_node_count(face_type));
            CHECK_INT(face_type, expected[t - ELEMENT_SURFACES]);
            CHECK_INT(sb_element_face(type, f, nodes, NULL), count);
            corners = sb_element_corner_count(face_type);
            x0 = element_node(type, nodes[0]), x1 = element_node(type, nodes[1]), x2 = element_node(type, nodes[2]);
            CHECK(sb_v3_dot(sb_v3_cross(sb_v3_sub(x1, x0), sb_v3_sub(x2, x0)), sb_v3_sub(x0, centre)) > 0);
            for (int c = 0; c < corners; c++)
                directed[nodes[c]][nodes[(c + 1) % corners]]++;
            for (int i = 0; i < sb_element_edge_count(face_type); i++) {
                if (sb_element_edge(face_type, i, edge) == 3) {
                    sb_vec3 middle =
                        element_middle(element_node(type, nodes[edge[0]]), element_node(type, nodes[edge[1]]));
                    CHECK(sb_v3_norm(sb_v3_sub(element_node(type, nodes[edge[2]]), middle)) == 0);
                }
            }
            if (face_type == SB_QUAD9)
                CHECK(sb_v3_norm(sb_v3_sub(element_node(type, nodes[8]), element_middle(x0, x2))) == 0);
        }
        for (int a = 0; a < 8; a++)
            for (int b = 0; b < 8; b++)
                CHECK(directed[a][b] == directed[b][a] && directed[a][b] <= 1);
    }
}

/* ---- quadrature ---- */

static double element_factorial(int n) { return n <= 1 ? 1 : n * element_factorial(n - 1); }

/* Integral of r^i s^j t^k over the parameter domain. */
static double element_monomial(sb_element_type type, int i, int j, int k)
{
    if (element_is_box(type)) {
        int flat = sb_element_dimension(type) == 2;
        if (i % 2 || j % 2 || k % 2)
            return 0;
        return 2.0 / (i + 1) * 2.0 / (j + 1) * (flat ? 1 : 2.0 / (k + 1));
    }
    return element_factorial(i) * element_factorial(j) * element_factorial(k) /
           element_factorial(i + j + k + sb_element_dimension(type));
}

static double element_integrate(int count, sb_real points[][3], const sb_real *weights, int i, int j, int k)
{
    double sum = 0;
    for (int q = 0; q < count; q++) {
        double value = (double)weights[q];
        for (int n = 0; n < i; n++)
            value *= (double)points[q][0];
        for (int n = 0; n < j; n++)
            value *= (double)points[q][1];
        for (int n = 0; n < k; n++)
            value *= (double)points[q][2];
        sum += value;
    }
    return sum;
}

typedef struct element_rule {
    sb_element_type type;
    sb_quadrature_kind kind;
    int points, degree;
} element_rule;

static const element_rule element_rules[] = {
    {SB_TET4, SB_QUADRATURE_STIFFNESS, 1, 1},
    {SB_TET4, SB_QUADRATURE_STIFFNESS_CURVED, 1, 1},
    {SB_TET4, SB_QUADRATURE_MASS, 4, 2},
    {SB_TET10, SB_QUADRATURE_STIFFNESS, 4, 2},
    {SB_TET10, SB_QUADRATURE_STIFFNESS_CURVED, 8, 3},
    {SB_TET10, SB_QUADRATURE_MASS, 14, 5},
    {SB_HEX8, SB_QUADRATURE_STIFFNESS, 8, 3},
    {SB_HEX8, SB_QUADRATURE_STIFFNESS_CURVED, 8, 3},
    {SB_HEX8, SB_QUADRATURE_MASS, 8, 3},
    {SB_TRI3, SB_QUADRATURE_FACE, 3, 2},
    {SB_TRI6, SB_QUADRATURE_FACE, 6, 4},
    {SB_QUAD4, SB_QUADRATURE_FACE, 4, 3},
    {SB_QUAD8, SB_QUADRATURE_FACE, 9, 5},
    {SB_QUAD9, SB_QUADRATURE_FACE, 9, 5},
    {SB_HEX20, SB_QUADRATURE_STIFFNESS, 27, 5},
    {SB_HEX20, SB_QUADRATURE_STIFFNESS_CURVED, 27, 5},
    {SB_HEX20, SB_QUADRATURE_MASS, 27, 5},
    {SB_HEX27, SB_QUADRATURE_STIFFNESS, 27, 5},
    {SB_HEX27, SB_QUADRATURE_STIFFNESS_CURVED, 27, 5},
    {SB_HEX27, SB_QUADRATURE_MASS, 27, 5},
    {SB_TRI3, SB_QUADRATURE_STIFFNESS, 3, 2},
    {SB_TRI6, SB_QUADRATURE_MASS, 6, 4},
};

/* Exact up to its degree, and not one further (in a box: per direction). */
static void test_quadrature_degree(void)
{
    for (size_t n = 0; n < sizeof element_rules / sizeof element_rules[0]; n++) {
        const element_rule *rule = &element_rules[n];
        sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
        int count = sb_element_quadrature(rule->type, rule->kind, points, weights), d = rule->degree;
        int flat = sb_element_dimension(rule->type) == 2, missed = 0;
        CHECK_INT(count, rule->points);
        for (int i = 0; i <= d + 1; i++) {
            for (int j = 0; i + j <= d + 1; j++) {
                for (int k = 0; i + j + k <= d + 1 && k <= (flat ? 0 : d + 1); k++) {
                    double error =
                        element_integrate(count, points, weights, i, j, k) - element_monomial(rule->type, i, j, k);
                    if (i + j + k <= d)
                        CHECK_NEAR(error, 0, element_eps(64));
                    else
                        missed += fabs(error) > 1e-5;
                }
            }
        }
        CHECK(missed > 0);
    }
}

/* The flux of x through the faces is three times the volume: every face has the right area and looks outward, and the
 * face's functions are those of the element on it. */
static void test_face_areas(void)
{
    for (int t = ELEMENT_SURFACES; t < ELEMENT_TYPES; t++) {
        sb_element_type type = element_types[t], face_type = SB_NO_ELEMENT;
        double volume = 0, domain = element_is_box(type) ? 8 : 1.0 / 6;
        for (int f = 0, nodes[SB_MAX_FACE_NODES]; sb_element_face(type, f, nodes, &face_type); f++) {
            sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
            int count = sb_element_quadrature(face_type, SB_QUADRATURE_FACE, points, weights);
            for (int q = 0; q < count; q++) {
                sb_real shape[SB_MAX_FACE_NODES], gradient[SB_MAX_FACE_NODES][3], xi[3], all[SB_MAX_ELEMENT_NODES];
                sb_vec3 x = sb_v3(0, 0, 0), r = x, s = x;
                double on_face = 0;
                sb_element_shape(face_type, points[q], shape, gradient);
                for (int a = 0; a < sb_element_node_count(face_type); a++) {
                    sb_vec3 node = element_node(type, nodes[a]);
                    x = sb_v3_madd(x, shape[a], node);
                    r = sb_v3_madd(r, gradient[a][0], node);
                    s = sb_v3_madd(s, gradient[a][1], node);
                }
                volume += (double)(weights[q] * sb_v3_dot(x, sb_v3_cross(r, s))) / 3;
                xi[0] = x.x, xi[1] = x.y, xi[2] = x.z;
                sb_element_shape(type, xi, all, NULL);
                for (int a = 0; a < sb_element_node_count(face_type); a++) {
                    CHECK_NEAR(all[nodes[a]], shape[a], element_eps(16));
                    on_face += (double)all[nodes[a]];
                }
                CHECK_NEAR(on_face, 1, element_eps(16));
            }
        }
        CHECK_NEAR(volume, domain, domain * element_eps(32));
    }
}

static void test_quadrature_points_inside(void)
{
    for (size_t n = 0; n < sizeof element_rules / sizeof element_rules[0]; n++) {
        const element_rule *rule = &element_rules[n];
        sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
        int count = sb_element_quadrature(rule->type, rule->kind, points, weights);
        int box = element_is_box(rule->type);
        for (int q = 0; q < count; q++) {
            sb_real sum = points[q][0] + points[q][1] + points[q][2];
            CHECK(weights[q] > 0);
            for (int k = 0; k < 3; k++)
                CHECK(points[q][k] >= (box ? -1 : 0) && points[q][k] <= 1);
            CHECK(box || (double)sum <= 1 + element_eps(4));
            if (sb_element_dimension(rule->type) == 2)
                CHECK(points[q][2] == 0);
        }
    }
}

/* ---- point order against a reference solution ---- */

enum { ELEMENT_REFERENCE_NODES = 4000 };

/* Positions of the nodes of one element in a legacy VTK file; 0 when the file is not as expected. */
static int element_read(const char *path, int element, int nodes, double x[][3])
{
    static double all[ELEMENT_REFERENCE_NODES][3];
    char word[128];
    int count = 0, index = 0, per = 0, ok = 0;
    FILE *file = fopen(path, "r");
    while (file && fscanf(file, "%127s", word) == 1 && strcmp(word, "POINTS") != 0)
        continue;
    if (file && fscanf(file, "%d %127s", &count, word) == 2 && count <= ELEMENT_REFERENCE_NODES) {
        for (ok = 1; index < count && ok; index++)
            ok = fscanf(file, "%lf %lf %lf", &all[index][0], &all[index][1], &all[index][2]) == 3;
        ok = ok && fscanf(file, "%127s %d %d", word, &count, &per) == 3 && strcmp(word, "CELLS") == 0;
        for (int e = 0; e <= element && ok; e++) {
            ok = fscanf(file, "%d", &per) == 1 && per == nodes;
            for (int a = 0; a < nodes && ok; a++) {
                ok = fscanf(file, "%d", &count) == 1 && count >= 0 && count < index;
                for (int k = 0; k < 3 && ok; k++)
                    x[a][k] = all[count][k];
            }
        }
    }
    if (file)
        fclose(file);
    return ok;
}

/* Compares our points with the positions in stress.txt, point by point. */
static void element_compare_points(const char *folder, sb_element_type type, int points_expected)
{
    char path[512], name[256], line[512];
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS], shape[SB_MAX_ELEMENT_NODES];
    double x[SB_MAX_ELEMENT_NODES][3], p[3];
    int compared = 0, element, ip, nodes = sb_element_node_count(type);
    FILE *stress;
    snprintf(name, sizeof name, "reference/%s/stress.txt", folder);
    if (!check_shared_path(path, sizeof path, name)) {
        CHECK_SKIP("no reference solutions");
        return;
    }
    stress = fopen(path, "r");
    snprintf(name, sizeof name, "reference/%s/mesh.vtk", folder);
    check_shared_path(path, sizeof path, name);
    CHECK_INT(sb_element_quadrature(type, SB_QUADRATURE_STIFFNESS, points, weights), points_expected);
    while (stress && fgets(line, sizeof line, stress)) {
        if (sscanf(line, "%d %d %lf %lf %lf", &element, &ip, &p[0], &p[1], &p[2]) != 5)
            continue;
        if (!CHECK(ip >= 0 && ip < points_expected) || !CHECK(element_read(path, element, nodes, x)))
            break;
        sb_element_shape(type, points[ip], shape, NULL);
        for (int k = 0; k < 3; k++) {
            double position = 0;
            for (int a = 0; a < nodes; a++)
                position += (double)shape[a] * x[a][k];
            CHECK_NEAR(position, p[k], 2e-9 + element_eps(1)); /* the file has 8 digits of 0.1 m */
        }
        compared++;
    }
    if (stress)
        fclose(stress);
    CHECK(compared >= points_expected && compared % points_expected == 0);
}

static void test_point_order_tet10(void) { element_compare_points("nh_cantilever_tet10", SB_TET10, 4); }
static void test_point_order_hex8(void) { element_compare_points("nh_cantilever_hex8", SB_HEX8, 8); }
static void test_point_order_hex20(void) { element_compare_points("nh_cantilever_hex20", SB_HEX20, 27); }

/* ---- tables of custom elements ---- */

/* A wedge: triangle (r, s) times t in [-1, 1]. user: factor of the gradients, 1 when they shall be right. */
static void element_wedge_shape(const void *user, const sb_real xi[3], sb_real *shape, sb_real (*gradient)[3])
{
    sb_real factor = user ? *(const sb_real *)user : (sb_real)1;
    for (int a = 0; a < 6; a++) {
        sb_real up = (sb_real)(a < 3 ? -0.5 : 0.5), height = (sb_real)0.5 + up * xi[2];
        sb_real flat = a % 3 == 0 ? 1 - xi[0] - xi[1] : xi[a % 3 - 1];
        if (shape)
            shape[a] = flat * height;
        for (int k = 0; gradient && k < 2; k++)
            gradient[a][k] = factor * height * (sb_real)(a % 3 == 0 ? -1 : a % 3 == k + 1);
        if (gradient)
            gradient[a][2] = factor * flat * up;
    }
}
static const sb_real element_wedge_nodes[6][3] = {{0, 0, -1}, {1, 0, -1}, {0, 1, -1}, {0, 0, 1}, {1, 0, 1}, {0, 1, 1}};
static const sb_element_table_face element_wedge_faces[5] = {{SB_TRI3, {0, 2, 1}},
                                                             {SB_TRI3, {3, 4, 5}},
                                                             {SB_QUAD4, {0, 1, 4, 3}},
                                                             {SB_QUAD4, {1, 2, 5, 4}},
                                                             {SB_QUAD4, {2, 0, 3, 5}}};
#define WEDGE_A (sb_real)(1.0 / 6)
#define WEDGE_B (sb_real)(2.0 / 3)
#define WEDGE_T (sb_real)0.57735026918962576451
static const sb_real element_wedge_points[6][3] = {{WEDGE_A, WEDGE_A, -WEDGE_T}, {WEDGE_B, WEDGE_A, -WEDGE_T},
                                                   {WEDGE_A, WEDGE_B, -WEDGE_T}, {WEDGE_A, WEDGE_A, WEDGE_T},
                                                   {WEDGE_B, WEDGE_A, WEDGE_T},  {WEDGE_A, WEDGE_B, WEDGE_T}};
static const sb_real element_wedge_weights[6] = {WEDGE_A, WEDGE_A, WEDGE_A, WEDGE_A, WEDGE_A, WEDGE_A};

static sb_element_table element_wedge(void)
{
    sb_element_table table;
    memset(&table, 0, sizeof table);
    table.name = "wedge";
    table.node_count = table.corner_count = 6;
    table.node_points = element_wedge_nodes;
    table.shape = element_wedge_shape;
    table.point_count = table.mass_point_count = 6;
    table.points = table.mass_points = element_wedge_points;
    table.weights = table.mass_weights = element_wedge_weights;
    table.face_count = 5;
    table.faces = element_wedge_faces;
    table.vtk_type = 13;
    return table;
}

/* The table is refused with this result, and the message says why. */
static void element_refused(const sb_element_table *table, sb_result expected, const char *why)
{
    sb_error error;
    CHECK_RESULT(sb_element_table_check(table, &error), expected);
    CHECK_RESULT(sb_element_table_check(table, NULL), expected);
    if (!CHECK(strstr(error.message, why) != NULL))
        printf("    message: %s\n", error.message);
}

static void test_table_counts(void)
{
    sb_element_table good = element_wedge(), bad;
    CHECK_OK(sb_element_table_check(&good, NULL));
    element_refused(NULL, SB_ERROR_ARGUMENT, "no element table");
    bad = good, bad.name = NULL, element_refused(&bad, SB_ERROR_ARGUMENT, "name is NULL");
    bad = good, bad.node_points = NULL, element_refused(&bad, SB_ERROR_ARGUMENT, "node_points is NULL");
    bad = good, bad.shape = NULL, element_refused(&bad, SB_ERROR_ARGUMENT, "shape is NULL");
    bad = good, bad.points = NULL, element_refused(&bad, SB_ERROR_ARGUMENT, "points or weights is NULL");
    bad = good, bad.mass_weights = NULL,
    element_refused(&bad, SB_ERROR_ARGUMENT, "mass_points or mass_weights is NULL");
    bad = good, bad.faces = NULL, element_refused(&bad, SB_ERROR_ARGUMENT, "faces is NULL");
    bad = good, bad.node_count = 33, element_refused(&bad, SB_ERROR_ARGUMENT, "33 nodes");
    bad = good, bad.node_count = -1, element_refused(&bad, SB_ERROR_ARGUMENT, "-1 nodes");
    bad = good, bad.corner_count = 7, element_refused(&bad, SB_ERROR_ARGUMENT, "7 corners");
    bad = good, bad.point_count = 0, element_refused(&bad, SB_ERROR_ARGUMENT, "0 points");
    bad = good, bad.mass_point_count = 28, element_refused(&bad, SB_ERROR_ARGUMENT, "28 mass points");
    bad = good, bad.face_count = 3, element_refused(&bad, SB_ERROR_ARGUMENT, "3 faces");
    bad = good, bad.face_count = 13, element_refused(&bad, SB_ERROR_ARGUMENT, "13 faces");
    bad = good, bad.vtk_type = -13, element_refused(&bad, SB_ERROR_ARGUMENT, "vtk_type -13");
}

static void test_table_faces(void)
{
    sb_element_table table = element_wedge();
    sb_element_table_face faces[5];
    table.faces = faces;
#define WEDGE_RESET() memcpy(faces, element_wedge_faces, sizeof faces)
    WEDGE_RESET(), faces[2].type = SB_HEX8;
    element_refused(&table, SB_ERROR_ARGUMENT, "face 2 is no tri3");
    WEDGE_RESET(), faces[4].nodes[3] = 6;
    element_refused(&table, SB_ERROR_INDEX, "node 3 of face 4 is 6");
    WEDGE_RESET(), faces[4].nodes[0] = -1;
    element_refused(&table, SB_ERROR_INDEX, "node 0 of face 4 is -1");
    WEDGE_RESET(), faces[0].nodes[1] = 1;
    element_refused(&table, SB_ERROR_ARGUMENT, "face 0 has node 1 twice");
    WEDGE_RESET(), faces[0].nodes[1] = 1, faces[0].nodes[2] = 2; /* one face turned round */
    element_refused(&table, SB_ERROR_ARGUMENT, "looks inward");
    WEDGE_RESET(), table.face_count = 4; /* one left out */
    element_refused(&table, SB_ERROR_ARGUMENT, "do not fit together");
    table.face_count = 5;
    for (int f = 0; f < 5; f++) { /* all turned round */
        int keep = faces[f].nodes[0], last = f < 2 ? 2 : 3;
        faces[f].nodes[0] = faces[f].nodes[last], faces[f].nodes[last] = keep;
        if (f >= 2)
            keep = faces[f].nodes[1], faces[f].nodes[1] = faces[f].nodes[2], faces[f].nodes[2] = keep;
    }
    element_refused(&table, SB_ERROR_ARGUMENT, "they look inward");
#undef WEDGE_RESET
}

static void test_table_numbers(void)
{
    sb_element_table table = element_wedge();
    sb_real points[6][3], weights[6], factor = (sb_real)1.1;
    volatile sb_real zero = 0;
    int swapped[6] = {0, 2, 1, 3, 5, 4};
    memcpy(points, element_wedge_points, sizeof points);
    memcpy(weights, element_wedge_weights, sizeof weights);
    table.points = (const sb_real(*)[3])points;
    table.weights = weights;
    weights[3] = -weights[3];
    element_refused(&table, SB_ERROR_ARGUMENT, "stiffness weight 3 is -0.16");
    weights[3] = (sb_real)0.2;
    element_refused(&table, SB_ERROR_ARGUMENT, "the stiffness weights sum to 1.03");
    check_bad_numbers();
    weights[3] = zero / zero;
    element_refused(&table, SB_ERROR_NOT_FINITE, "stiffness point 3 is not finite");
    weights[3] = WEDGE_A, points[5][1] = 1 / zero;
    element_refused(&table, SB_ERROR_NOT_FINITE, "stiffness point 5 is not finite");
    points[5][1] = WEDGE_B, table.mass_points = table.points, table.mass_weights = table.weights;
    CHECK_OK(sb_element_table_check(&table, NULL));
    table.user = &factor; /* gradients a tenth too long */
    element_refused(&table, SB_ERROR_ARGUMENT, "the slope of its shape function is");
    table.user = NULL;
    for (int a = 0; a < 6; a++)
        memcpy(points[a], element_wedge_nodes[swapped[a]], sizeof points[a]);
    table = element_wedge();
    table.node_points = (const sb_real(*)[3])points; /* two nodes of each triangle changed places */
    element_refused(&table, SB_ERROR_ARGUMENT, "shape function");
    memcpy(points, element_wedge_nodes, sizeof points);
    points[2][0] = zero / zero;
    element_refused(&table, SB_ERROR_NOT_FINITE, "node_points[2] is not finite");
}

CHECK_SUITE(element, {"counts and names", test_counts}, {"unknown types and numbers", test_unknown},
            {"shape functions are 1 at their node", test_kronecker},
            {"shape functions reproduce linear fields", test_completeness},
            {"gradients by differences", test_gradient_by_differences}, {"edges", test_edges}, {"faces", test_faces},
            {"quadrature degrees", test_quadrature_degree}, {"quadrature points inside", test_quadrature_points_inside},
            {"point order of tet10 as in the reference", test_point_order_tet10},
            {"point order of hex8 as in the reference", test_point_order_hex8},
            {"point order of hex20 as in the reference", test_point_order_hex20},
            {"areas and functions of faces", test_face_areas},
            {"element tables: counts and pointers", test_table_counts}, {"element tables: faces", test_table_faces},
            {"element tables: numbers", test_table_numbers});
