/* Tests of surface: queries against brute force and closed forms, signs against winding numbers and rays, checks and
 * repairs. */
#include "scene.h"

#define SURFACE_PI 3.14159265358979323846

/* ---- surfaces to ask ---- */

/* Boundary of a liver-like solid: a few hundred triangles, smooth and concave. */
static sb_mesh surface_organ(int cells)
{
    sb_mesh solid, skin;
    sb_boundary boundary;
    memset(&skin, 0, sizeof skin);
    if (!CHECK_OK(sb_mesh_organ(SB_TET4, cells, NULL, &solid, NULL)))
        return skin;
    if (CHECK_OK(sb_mesh_boundary(&solid, 1, NULL, &boundary, NULL))) {
        CHECK_OK(sb_mesh_copy(&boundary.surface, NULL, &skin, NULL));
        sb_boundary_free(&boundary);
    }
    sb_mesh_free(&solid);
    return skin;
}

/* Boundary of the box [0, size] of one layer of cells. */
static sb_mesh surface_box(sb_element_type type, int cells, double size)
{
    sb_mesh solid = scene_box(type, cells, cells, cells, sb_v3(REAL(size), REAL(size), REAL(size)), 0), skin;
    sb_boundary boundary;
    memset(&skin, 0, sizeof skin);
    if (CHECK_OK(sb_mesh_boundary(&solid, 1, NULL, &boundary, NULL))) {
        CHECK_OK(sb_mesh_copy(&boundary.surface, NULL, &skin, NULL));
        sb_boundary_free(&boundary);
    }
    sb_mesh_free(&solid);
    return skin;
}

/* A ball whose nodes were moved in or out at random: spikes and pits with sharp corners, closed, star-shaped. */
static sb_mesh surface_spiky(double depth)
{
    sb_mesh solid, skin;
    sb_boundary boundary;
    unsigned long long seed = 5;
    memset(&skin, 0, sizeof skin);
    if (!CHECK_OK(sb_mesh_ellipsoid(SB_TET4, sb_v3(1, 1, 1), 10, NULL, &solid, NULL)))
        return skin;
    if (CHECK_OK(sb_mesh_boundary(&solid, 1, NULL, &boundary, NULL))) {
        CHECK_OK(sb_mesh_copy(&boundary.surface, NULL, &skin, NULL));
        sb_boundary_free(&boundary);
    }
    sb_mesh_free(&solid);
    for (int v = 0; v < skin.node_count; v++)
        skin.nodes[v] = sb_v3_scale(REAL(check_random_in(&seed, 1 - depth, 1 + depth)), skin.nodes[v]);
    return skin;
}

static sb_surface *surface_make(const sb_mesh *mesh)
{
    sb_surface *surface = NULL;
    sb_error error;
    if (sb_surface_create(mesh, NULL, &surface, &error) != SB_OK) {
        printf("%s: %s\n", sb_result_string(error.result), error.message);
        CHECK(surface != NULL);
    }
    return surface;
}

/* A random point of the box around the mesh, widened by `margin` of its sides. */
static sb_vec3 surface_point(const sb_mesh *mesh, double margin, unsigned long long *seed)
{
    sb_vec3 low, high, side;
    sb_mesh_bounds(mesh, &low, &high);
    side = sb_v3_sub(high, low);
    return sb_v3(low.x + side.x * REAL(check_random_in(seed, -margin, 1 + margin)),
                 low.y + side.y * REAL(check_random_in(seed, -margin, 1 + margin)),
                 low.z + side.z * REAL(check_random_in(seed, -margin, 1 + margin)));
}

static double surface_size(const sb_mesh *mesh)
{
    sb_vec3 low, high;
    sb_mesh_bounds(mesh, &low, &high);
    return (double)sb_v3_norm(sb_v3_sub(high, low));
}

static void surface_corners(const sb_mesh *mesh, int triangle, double x[3][3])
{
    for (int i = 0; i < 3; i++) {
        sb_vec3 node = mesh->nodes[mesh->elements[3 * triangle + i]];
        x[i][0] = (double)node.x, x[i][1] = (double)node.y, x[i][2] = (double)node.z;
    }
}

static double surface_dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
static void surface_minus(const double a[3], const double b[3], double c[3])
{
    for (int i = 0; i < 3; i++)
        c[i] = a[i] - b[i];
}
static void surface_cross(const double a[3], const double b[3], double c[3])
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

/* Distance to a triangle in another way than the library's: height over the plane when the foot is inside, else the
 * nearest of three segments. */
static double surface_brute_triangle(double x[3][3], const double p[3])
{
    double ab[3], ac[3], n[3], q[3], best = 1e300, area;
    int inside = 1;
    surface_minus(x[1], x[0], ab);
    surface_minus(x[2], x[0], ac);
    surface_cross(ab, ac, n);
    area = sqrt(surface_dot(n, n));
    for (int i = 0; i < 3; i++) {
        double edge[3], side[3], t, length;
        surface_minus(x[(i + 1) % 3], x[i], edge);
        surface_minus(p, x[i], q);
        surface_cross(n, edge, side);
        inside = inside && surface_dot(side, q) >= 0;
        length = surface_dot(edge, edge);
        t = length > 0 ? surface_dot(q, edge) / length : 0;
        t = t < 0 ? 0 : t > 1 ? 1 : t;
        for (int k = 0; k < 3; k++)
            q[k] -= t * edge[k];
        t = sqrt(surface_dot(q, q));
        best = t < best ? t : best;
    }
    surface_minus(p, x[0], q);
    if (area > 0 && inside)
        best = fabs(surface_dot(q, n)) / area;
    return best;
}

static double surface_brute(const sb_mesh *mesh, sb_vec3 point)
{
    double best = 1e300, p[3], x[3][3];
    p[0] = (double)point.x, p[1] = (double)point.y, p[2] = (double)point.z;
    for (int t = 0; t < mesh->element_count; t++) {
        double distance;
        surface_corners(mesh, t, x);
        distance = surface_brute_triangle(x, p);
        best = distance < best ? distance : best;
    }
    return best;
}

/* ---- closest point ---- */

/* A hit must be what it says: on its triangle, at its distance, on the feature it names. */
static int surface_hit_is_sound(const sb_mesh *mesh, sb_vec3 point, const sb_surface_hit *hit, double size)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    double tolerance = 64 * (double)SB_EPSILON * (size + (double)sb_v3_norm(point)), total = 0;
    int zeros = 0, ok = hit->triangle >= 0 && hit->element == hit->triangle && hit->index >= 0 && hit->index < 3;
    for (int i = 0; ok && i < 3; i++) {
        sum = sb_v3_madd(sum, hit->weights[i], mesh->nodes[mesh->elements[3 * hit->triangle + i]]);
        total += (double)hit->weights[i];
        zeros += hit->weights[i] == 0;
        ok = ok && hit->weights[i] >= -64 * SB_EPSILON;
    }
    ok = ok && fabs(total - 1) < 8 * (double)SB_EPSILON;
    ok = ok && (double)sb_v3_norm(sb_v3_sub(sum, hit->point)) < tolerance;
    ok = ok && fabs((double)(sb_v3_norm(sb_v3_sub(point, hit->point)) - sb_abs(hit->distance))) < tolerance;
    if (ok && hit->feature == SB_SURFACE_VERTEX)
        ok = zeros == 2 && hit->weights[hit->index] == 1;
    if (ok && hit->feature == SB_SURFACE_EDGE)
        ok = hit->weights[(hit->index + 2) % 3] <= 8 * SB_EPSILON;
    return ok;
}

static void surface_check_closest(const sb_mesh *mesh, int count, double margin)
{
    sb_surface *surface = surface_make(mesh);
    unsigned long long seed = 11;
    double size = surface_size(mesh), worst = 0;
    int unsound = 0;
    for (int i = 0; surface && i < count; i++) {
        sb_vec3 p = surface_point(mesh, margin, &seed);
        sb_surface_hit hit;
        double off;
        CHECK_INT(sb_surface_closest(surface, p, SB_REAL_MAX, &hit), 1);
        off = fabs((double)hit.distance - surface_brute(mesh, p)) / size;
        worst = off > worst ? off : worst;
        unsound += !surface_hit_is_sound(mesh, p, &hit, size);
    }
    CHECK_NEAR(worst, 0, 32 * (double)SB_EPSILON * (1 + margin));
    CHECK_INT(unsound, 0);
    sb_surface_destroy(surface);
}

static void test_closest_brute_force(void)
{
    static const double scales[] = {1e-3, 1, 1e3};
    for (int k = 0; k < 3; k++) {
        sb_mesh organ = surface_organ(8), spiky = surface_spiky(0.4);
        CHECK_OK(sb_mesh_scale(&organ, REAL(scales[k]), NULL));
        CHECK_OK(sb_mesh_scale(&spiky, REAL(scales[k]), NULL));
        surface_check_closest(&organ, 300, 0.1);
        surface_check_closest(&organ, 100, 3);
        surface_check_closest(&spiky, 200, 0.1);
        sb_mesh_free(&organ);
        sb_mesh_free(&spiky);
    }
}

/* Same bits at scales that are powers of two. */
static void test_closest_scales(void)
{
    sb_mesh mesh = surface_organ(6), large;
    sb_surface *a = surface_make(&mesh), *b;
    unsigned long long seed = 3;
    sb_real factor = 1024 * 1024;
    int different = 0;
    CHECK_OK(sb_mesh_copy(&mesh, NULL, &large, NULL));
    CHECK_OK(sb_mesh_scale(&large, factor, NULL));
    b = surface_make(&large);
    for (int i = 0; i < 200; i++) {
        sb_vec3 p = surface_point(&mesh, 0.5, &seed);
        sb_surface_hit hit, other;
        sb_surface_closest(a, p, SB_REAL_MAX, &hit);
        sb_surface_closest(b, sb_v3_scale(factor, p), SB_REAL_MAX, &other);
        different += hit.triangle != other.triangle || hit.distance * factor != other.distance ||
                     memcmp(hit.weights, other.weights, sizeof hit.weights) != 0;
    }
    CHECK_INT(different, 0);
    sb_surface_destroy(a);
    sb_surface_destroy(b);
    sb_mesh_free(&mesh);
    sb_mesh_free(&large);
}

/* The answer is the smallest of the triangles' own distances, to the bit, whatever triangle the search starts from. */
static void test_closest_is_the_least(void)
{
    sb_mesh mesh = surface_box(SB_TET4, 3, 1), one = mesh;
    sb_surface *surface = surface_make(&mesh), *single[200];
    unsigned long long seed = 17;
    int wrong = 0;
    CHECK(mesh.element_count <= 200);
    one.element_count = 1;
    for (int t = 0; t < mesh.element_count; t++) {
        one.elements = mesh.elements + 3 * t;
        single[t] = surface_make(&one);
    }
    for (int i = 0; i < 1000; i++) {
        sb_vec3 p = surface_point(&mesh, 0.5, &seed);
        sb_surface_hit hit, own;
        sb_real best = SB_REAL_MAX;
        if (i % 2) /* on a lattice that has ties galore */
            p = sb_v3((sb_real)((int)(p.x * 6) / 6.0), (sb_real)((int)(p.y * 6) / 6.0),
                      (sb_real)((int)(p.z * 6) / 6.0));
        for (int t = 0; t < mesh.element_count; t++) {
            sb_surface_closest(single[t], p, SB_REAL_MAX, &own);
            best = sb_min(best, own.distance);
        }
        sb_surface_closest(surface, p, SB_REAL_MAX, &hit);
        sb_surface_closest(single[hit.triangle], p, SB_REAL_MAX, &own);
        wrong += hit.distance != best || own.distance != best;
        for (int k = 0; k < 5; k++) {
            sb_surface_closest_from(surface, p, SB_REAL_MAX, (i * 7 + k * 31) % mesh.element_count, &own);
            wrong += memcmp(&own, &hit, sizeof hit) != 0;
        }
    }
    CHECK_INT(wrong, 0);
    for (int t = 0; t < mesh.element_count; t++)
        sb_surface_destroy(single[t]);
    sb_surface_destroy(surface);
    sb_mesh_free(&mesh);
}

static sb_mesh surface_of(sb_vec3 *nodes, int node_count, int *elements, int element_count)
{
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    mesh.nodes = nodes;
    mesh.node_count = node_count;
    mesh.element_type = SB_TRI3;
    mesh.elements = elements;
    mesh.element_count = element_count;
    return mesh;
}

/* One right triangle: every region has a point whose closest point is known. */
static void test_features(void)
{
    static const struct {
        double p[3], closest[3];
        sb_surface_feature feature;
        int index;
    } cases[] = {
        {{0.25, 0.25, 2}, {0.25, 0.25, 0}, SB_SURFACE_FACE, 0}, {{0.5, 0.25, -1}, {0.5, 0.25, 0}, SB_SURFACE_FACE, 0},
        {{0.5, -1, 1}, {0.5, 0, 0}, SB_SURFACE_EDGE, 0},        {{1, 1, 3}, {0.5, 0.5, 0}, SB_SURFACE_EDGE, 1},
        {{-2, 0.5, 0}, {0, 0.5, 0}, SB_SURFACE_EDGE, 2},        {{-1, -2, 1}, {0, 0, 0}, SB_SURFACE_VERTEX, 0},
        {{3, -1, 0}, {1, 0, 0}, SB_SURFACE_VERTEX, 1},          {{-1, 4, 0}, {0, 1, 0}, SB_SURFACE_VERTEX, 2}};
    sb_vec3 nodes[3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    int elements[3] = {0, 1, 2};
    sb_mesh mesh = surface_of(nodes, 3, elements, 1);
    sb_surface *surface = surface_make(&mesh);
    CHECK_INT(sb_surface_is_closed(surface), 0);
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        sb_vec3 p = sb_v3(REAL(cases[i].p[0]), REAL(cases[i].p[1]), REAL(cases[i].p[2]));
        sb_vec3 c = sb_v3(REAL(cases[i].closest[0]), REAL(cases[i].closest[1]), REAL(cases[i].closest[2]));
        sb_surface_hit hit;
        CHECK_INT(sb_surface_closest(surface, p, 10, &hit), 1);
        CHECK_INT(hit.feature, cases[i].feature);
        CHECK_INT(hit.index, cases[i].index);
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(hit.point, c)), 0, 4 * (double)SB_EPSILON);
        CHECK_NEAR(hit.distance, sb_v3_norm(sb_v3_sub(p, c)), 8 * (double)SB_EPSILON);
        CHECK_NEAR(sb_surface_normal(surface, &hit).z, 1, 4 * (double)SB_EPSILON);
    }
    sb_surface_destroy(surface);
}

/* Ties on a cube: its centre is as far from all faces; normals at edges and corners are means. */
static void test_cube(void)
{
    sb_mesh mesh = surface_box(SB_HEX8, 1, 2);
    sb_surface *surface = surface_make(&mesh);
    double eps = 16 * (double)SB_EPSILON, third = 1 / sqrt(3.0);
    sb_surface_hit hit;
    sb_vec3 n, low, high;
    CHECK_INT(sb_surface_triangle_count(surface), 12);
    CHECK_INT(sb_surface_is_closed(surface), 1);
    sb_surface_bounds(surface, &low, &high);
    CHECK(low.x == 0 && low.y == 0 && low.z == 0 && high.x == 2 && high.y == 2 && high.z == 2);
    CHECK_NEAR(sb_surface_signed_distance(surface, sb_v3(1, 1, 1), &hit), -1, 0);
    CHECK_INT(hit.triangle, 0);
    CHECK_NEAR(hit.distance, -1, 0);
    CHECK_NEAR(sb_surface_signed_distance(surface, sb_v3(3, 3, 3), &hit), sqrt(3.0), eps);
    CHECK_INT(hit.feature, SB_SURFACE_VERTEX);
    n = sb_surface_normal(surface, &hit);
    CHECK(fabs((double)n.x - third) < eps && fabs((double)n.y - third) < eps && fabs((double)n.z - third) < eps);
    CHECK_NEAR(sb_surface_signed_distance(surface, sb_v3(1, 3, 3), &hit), sqrt(2.0), eps);
    CHECK_NEAR(sb_surface_signed_distance(surface, sb_v3(REAL(1.5), REAL(0.25), 1), NULL), -0.25, 0);
    CHECK_NEAR(sb_surface_signed_distance(surface, sb_v3(REAL(1.5), 0, 1), NULL), 0, 0);
    CHECK_INT(sb_surface_closest(surface, sb_v3(1, 1, 4), 2, &hit), 1);
    CHECK_INT(sb_surface_closest(surface, sb_v3(1, 1, 4), REAL(1.999), &hit), 0);
    CHECK_INT(hit.triangle, -1);
    CHECK_INT(sb_surface_closest(surface, sb_v3(1, 1, 4), 3, NULL), 1);
    sb_surface_destroy(surface);
    sb_mesh_free(&mesh);
}

/* ---- signs ---- */

/* Signs by normals, by winding numbers and by counting what a ray meets agree; points within rounding of the surface
 * may be on either side. */
static void surface_check_signs(const sb_mesh *mesh, int count)
{
    sb_surface *surface = surface_make(mesh);
    unsigned long long seed = 23;
    double size = surface_size(mesh), worst = 0, whole = 0;
    int wrong = 0, odd = 0, inside = 0;
    CHECK_INT(sb_surface_is_closed(surface), 1);
    for (int i = 0; surface && i < count; i++) {
        sb_vec3 p = surface_point(mesh, 0.05, &seed), direction;
        double exact = (double)sb_surface_winding_number_exact(surface, p);
        double fast = (double)sb_surface_winding_number(surface, p), distance;
        direction = sb_v3(REAL(check_random_in(&seed, -1, 1)), REAL(check_random_in(&seed, -1, 1)),
                          REAL(check_random_in(&seed, -1, 1)));
        distance = (double)sb_surface_signed_distance(surface, p, NULL);
        if (fabs(distance) < 100 * (double)SB_EPSILON * size)
            continue;
        inside += distance < 0;
        wrong += (distance < 0) != (exact > 0.5);
        wrong += sb_surface_inside(surface, p) != (distance < 0);
        wrong += (double)sb_surface_signed_distance_winding(surface, p, NULL) != distance;
        odd += (sb_surface_ray_all(surface, p, direction, SB_REAL_MAX, NULL, 0) & 1) != (distance < 0);
        worst = fabs(fast - exact) > worst ? fabs(fast - exact) : worst;
        distance = fabs(exact - (exact > 0.5));
        whole = distance > whole ? distance : whole;
    }
    CHECK_INT(wrong, 0);
    CHECK_INT(odd, 0);
    CHECK(inside > count / 20);
    CHECK_NEAR(worst, 0, 0.05);
    CHECK_NEAR(whole, 0, scene_tolerance(1e-11, 3e4));
    sb_surface_destroy(surface);
}

static void test_signs(void)
{
    sb_mesh organ = surface_organ(10), spiky = surface_spiky(0.5), box = surface_box(SB_TET4, 2, 1);
    surface_check_signs(&organ, 400);
    surface_check_signs(&spiky, 600);
    surface_check_signs(&box, 300);
    sb_mesh_free(&organ);
    sb_mesh_free(&spiky);
    sb_mesh_free(&box);
}

static void test_signs_of_shared_surfaces(void)
{
    static const char *names[] = {"liver_a", "liver_b", "bunny", "torus", "liver_a_uniform_fine"};
    char path[512], name[64];
    for (int i = 0; i < 5; i++) {
        sb_mesh mesh;
        snprintf(name, sizeof name, "data/surfaces/%s.obj", names[i]);
        if (!check_shared_path(path, sizeof path, name)) {
            CHECK_SKIP("no shared surfaces");
            return;
        }
        if (!CHECK_OK(sb_mesh_load(&mesh, path, NULL, NULL)))
            return;
        surface_check_signs(&mesh, 100);
        surface_check_closest(&mesh, 20, 0.1);
        sb_mesh_free(&mesh);
    }
}

/* A box whose top is cut along collinear nodes: triangles without area close the gap. */
static sb_mesh surface_with_flat_triangle(sb_vec3 nodes[9], int elements[42])
{
    sb_mesh box = surface_box(SB_HEX8, 1, 1), mesh;
    int count = 0, found = 0;
    memcpy(nodes, box.nodes, 8 * sizeof(sb_vec3));
    for (int e = 0; e < 6; e++) {
        const int *q = box.elements + 4 * e;
        int t[6];
        t[0] = q[0], t[1] = q[1], t[2] = q[2], t[3] = q[0], t[4] = q[2], t[5] = q[3];
        if (found++ == 0) { /* its diagonal gets a node that only one side knows, and a triangle on the other */
            nodes[8] = sb_v3_scale(REAL(0.5), sb_v3_add(nodes[q[0]], nodes[q[2]]));
            elements[count++] = q[0], elements[count++] = q[1], elements[count++] = 8;
            elements[count++] = 8, elements[count++] = q[1], elements[count++] = q[2];
            elements[count++] = q[0], elements[count++] = 8, elements[count++] = q[2];
            memcpy(elements + count, t + 3, 3 * sizeof(int));
            count += 3;
            continue;
        }
        memcpy(elements + count, t, sizeof t);
        count += 6;
    }
    mesh = surface_of(nodes, 9, elements, count / 3);
    sb_mesh_free(&box);
    return mesh;
}

static void test_degenerate_triangles(void)
{
    sb_vec3 nodes[9];
    int elements[45], wrong = 0;
    sb_mesh mesh = surface_with_flat_triangle(nodes, elements);
    sb_surface *surface;
    unsigned long long seed = 31;
    CHECK_INT(mesh.element_count, 14);
    elements[42] = elements[43] = 3, elements[44] = 5; /* and one with a node twice */
    mesh.element_count = 15;
    surface = surface_make(&mesh);
    CHECK_INT(sb_surface_is_closed(surface), 1);
    for (int i = 0; i < 2000; i++) {
        sb_vec3 p = surface_point(&mesh, 0.5, &seed);
        double dx[3], out = 0, in = -1, distance = (double)sb_surface_signed_distance(surface, p, NULL);
        if (i % 4 == 0) /* straight over the diagonal */
            p = sb_v3_madd(nodes[8], REAL(check_random_in(&seed, -0.4, 0.4)),
                           sb_v3_sub(nodes[8], sb_v3(REAL(0.5), REAL(0.5), REAL(0.5))));
        dx[0] = fabs((double)p.x - 0.5) - 0.5, dx[1] = fabs((double)p.y - 0.5) - 0.5,
        dx[2] = fabs((double)p.z - 0.5) - 0.5;
        for (int k = 0; k < 3; k++) {
            out += dx[k] > 0 ? dx[k] * dx[k] : 0;
            in = dx[k] > in ? dx[k] : in;
        }
        distance = (double)sb_surface_signed_distance(surface, p, NULL);
        wrong += fabs(distance - (in > 0 ? sqrt(out) : in)) > 16 * (double)SB_EPSILON;
        wrong += fabs((double)sb_surface_winding_number_exact(surface, p) - (in < 0)) > 1e4 * (double)SB_EPSILON;
    }
    CHECK_INT(wrong, 0);
    sb_surface_destroy(surface);
}

/* Slivers of every thinness, near and far: distances as good as those of the brute force. */
static void test_slivers(void)
{
    for (int i = 0; i < 60; i++) {
        double thin = pow(10, -0.3 * i);
        sb_vec3 nodes[3];
        int elements[3] = {0, 1, 2};
        sb_mesh mesh = surface_of(nodes, 3, elements, 1);
        nodes[0] = sb_v3(0, 0, 0), nodes[1] = sb_v3(REAL(0.6), REAL(0.8), 0);
        nodes[2] = sb_v3(REAL(0.24 - 0.8 * thin), REAL(0.32 + 0.6 * thin), REAL(0.3 * thin));
        surface_check_closest(&mesh, 20, 0.5);
    }
}

/* ---- winding numbers ---- */

/* From the centre of a cube every side fills a sixth of the view; from outside near an open box, less. */
static void test_winding_number_of_open_box(void)
{
    sb_mesh mesh = surface_box(SB_TET4, 4, 1);
    sb_surface *surface;
    sb_vec3 centre = sb_v3(REAL(0.5), REAL(0.5), REAL(0.5));
    int kept = 0;
    for (int e = 0; e < mesh.element_count; e++) {
        const int *nodes = mesh.elements + 3 * e;
        if (mesh.nodes[nodes[0]].z == 1 && mesh.nodes[nodes[1]].z == 1 && mesh.nodes[nodes[2]].z == 1)
            continue;
        memmove(mesh.elements + 3 * kept++, nodes, 3 * sizeof(int));
    }
    CHECK_INT(mesh.element_count - kept, 32);
    mesh.element_count = kept;
    surface = surface_make(&mesh);
    CHECK_INT(sb_surface_is_closed(surface), 0);
    CHECK_NEAR(sb_surface_winding_number_exact(surface, centre), 5.0 / 6, 100 * (double)SB_EPSILON);
    CHECK_NEAR(sb_surface_winding_number(surface, centre), 5.0 / 6, 0.01);
    CHECK_INT(sb_surface_inside(surface, centre), 1);
    CHECK_INT(sb_surface_inside(surface, sb_v3(REAL(0.5), REAL(0.5), 2)), 0);
    /* nearest to the side of the hole, the plain sign would be that of the side */
    CHECK(sb_surface_signed_distance_winding(surface, sb_v3(REAL(0.9), REAL(0.5), REAL(0.9)), NULL) < 0);
    CHECK(sb_surface_signed_distance_winding(surface, sb_v3(REAL(0.9), REAL(0.5), REAL(1.5)), NULL) > 0);
    sb_surface_destroy(surface);
    sb_mesh_free(&mesh);
}

/* Two solids that overlap: 2 in the common part. Far away: 0. */
static void test_winding_number_of_overlap(void)
{
    sb_mesh mesh = surface_box(SB_TET4, 2, 1), other = surface_box(SB_TET4, 2, 1);
    sb_surface *surface;
    for (int v = 0; v < other.node_count; v++)
        other.nodes[v].x += REAL(0.5);
    CHECK_OK(sb_mesh_append(&mesh, &other, NULL));
    surface = surface_make(&mesh);
    CHECK_NEAR(sb_surface_winding_number_exact(surface, sb_v3(REAL(0.75), REAL(0.4), REAL(0.6))), 2,
               1e3 * (double)SB_EPSILON);
    CHECK_NEAR(sb_surface_winding_number(surface, sb_v3(REAL(0.75), REAL(0.4), REAL(0.6))), 2, 0.05);
    CHECK_NEAR(sb_surface_winding_number(surface, sb_v3(REAL(1.25), REAL(0.4), REAL(0.6))), 1, 0.05);
    CHECK_NEAR(sb_surface_winding_number(surface, sb_v3(50, 20, 30)), 0, 1e-4);
    sb_surface_destroy(surface);
    sb_mesh_free(&mesh);
    sb_mesh_free(&other);
}

/* ---- rays ---- */

/* Where the ray meets the triangle, by solving for it; negative: nowhere. */
static double surface_brute_ray(double x[3][3], const double o[3], const double d[3])
{
    double ab[3], ac[3], q[3], h[3], g[3], det, u, v, t;
    surface_minus(x[1], x[0], ab);
    surface_minus(x[2], x[0], ac);
    surface_minus(o, x[0], q);
    surface_cross(d, ac, h);
    surface_cross(q, ab, g);
    det = surface_dot(ab, h);
    if (det == 0)
        return -1;
    u = surface_dot(q, h) / det;
    v = surface_dot(d, g) / det;
    t = surface_dot(ac, g) / det;
    return u >= 0 && v >= 0 && u + v <= 1 ? t : -1;
}

static void test_rays_brute_force(void)
{
    sb_mesh mesh = surface_organ(8);
    sb_surface *surface = surface_make(&mesh);
    unsigned long long seed = 41;
    double size = surface_size(&mesh), tolerance = scene_tolerance(1e-9, 3e3) * size;
    int wrong = 0, met = 0;
    for (int i = 0; i < 400; i++) {
        sb_vec3 p = surface_point(&mesh, 0.5, &seed), target = surface_point(&mesh, 0, &seed), d = sb_v3_sub(target, p);
        sb_surface_hit first, all[64];
        double o[3], direction[3], x[3][3], best = -1, length = (double)sb_v3_norm(d);
        int count = 0, found = sb_surface_ray(surface, p, d, SB_REAL_MAX, &first);
        o[0] = (double)p.x, o[1] = (double)p.y, o[2] = (double)p.z;
        direction[0] = (double)d.x / length, direction[1] = (double)d.y / length, direction[2] = (double)d.z / length;
        for (int t = 0; t < mesh.element_count; t++) {
            double at;
            surface_corners(&mesh, t, x);
            at = surface_brute_ray(x, o, direction);
            count += at >= 0;
            if (at >= 0 && (best < 0 || at < best))
                best = at;
        }
        met += found;
        wrong += found != (best >= 0);
        if (found) {
            wrong += fabs((double)first.distance - best) > tolerance;
            wrong +=
                (double)sb_v3_norm(sb_v3_sub(first.point, sb_v3_madd(p, first.distance / REAL(length), d))) > tolerance;
            wrong += sb_surface_ray(surface, p, d, first.distance * REAL(0.99), NULL);
        }
        wrong += sb_surface_ray_all(surface, p, d, SB_REAL_MAX, all, 64) != count;
        wrong += found && (all[0].triangle != first.triangle || all[0].distance != first.distance);
        for (int k = 1; k < count && k < 64; k++)
            wrong += all[k].distance < all[k - 1].distance;
    }
    CHECK_INT(wrong, 0);
    CHECK(met > 100);
    sb_surface_destroy(surface);
    sb_mesh_free(&mesh);
}

/* Rays aimed at corners, at points of edges and along axes through them never slip through a closed surface. */
static void test_rays_are_watertight(void)
{
    sb_mesh mesh = surface_spiky(0.2), box = surface_box(SB_TET4, 4, 1);
    sb_surface *surface = surface_make(&mesh), *cube = surface_make(&box);
    int missed = 0;
    for (int t = 0; t < mesh.element_count; t++) {
        for (int i = 0; i < 3; i++) {
            sb_vec3 a = mesh.nodes[mesh.elements[3 * t + i]], b = mesh.nodes[mesh.elements[3 * t + (i + 1) % 3]];
            for (int k = 0; k < 4; k++)
                missed +=
                    !sb_surface_ray(surface, sb_v3(0, 0, 0), sb_v3_madd(a, REAL(k) / 3, sb_v3_sub(b, a)), 10, NULL);
        }
    }
    for (int i = 0; i <= 16; i++) /* along axes, through nodes, edges and diagonals; the rim is edge-on to the sides */
        for (int j = 0; j <= 16; j++)
            missed += !sb_surface_ray(cube, sb_v3(REAL(i) / 16, REAL(j) / 16, -1), sb_v3(0, 0, 1), 10, NULL);
    CHECK_INT(missed, 0);
    sb_surface_destroy(surface);
    sb_surface_destroy(cube);
    sb_mesh_free(&mesh);
    sb_mesh_free(&box);
}

static void test_ray_arguments(void)
{
    sb_mesh box = surface_box(SB_TET4, 1, 1);
    sb_surface *cube = surface_make(&box);
    sb_vec3 o = sb_v3(REAL(0.3), REAL(0.4), -2), up = sb_v3(0, 0, REAL(1e-12));
    sb_surface_hit hit, two[2];
    CHECK_INT(sb_surface_ray(cube, o, up, 10, &hit), 1);
    CHECK_NEAR(hit.distance, 2, 8 * (double)SB_EPSILON);
    CHECK_INT(sb_surface_ray(cube, o, up, REAL(1.999), &hit), 0);
    CHECK_INT(hit.triangle, -1);
    CHECK_INT(sb_surface_ray(cube, o, sb_v3(0, 0, -1), 10, &hit), 0);
    CHECK_INT(sb_surface_ray(cube, o, sb_v3(0, 0, 0), 10, &hit), 0);
    CHECK_INT(sb_surface_ray(cube, o, up, -1, &hit), 0);
    CHECK_INT(sb_surface_ray(NULL, o, up, 10, &hit), 0);
    CHECK_INT(sb_surface_ray_all(cube, o, up, 10, two, 1), 2);
    CHECK_NEAR(two[0].distance, 2, 8 * (double)SB_EPSILON);
    CHECK_INT(sb_surface_ray_all(cube, o, up, 10, two, -5), 2);
    CHECK_INT(sb_surface_ray_all(cube, o, up, REAL(2.5), two, 2), 1);
    CHECK_INT(sb_surface_ray_all(NULL, o, up, 10, two, 2), 0);
    /* from far away */
    CHECK_INT(sb_surface_ray(cube, sb_v3(REAL(0.3), REAL(0.4), REAL(-1e4)), sb_v3(0, 0, 1), SB_REAL_MAX, &hit), 1);
    CHECK_NEAR(hit.distance, 1e4, 1e4 * 8 * (double)SB_EPSILON);
    check_bad_numbers();
    CHECK_INT(sb_surface_ray(cube, o, sb_v3(0, REAL(NAN), 1), 10, &hit), 0);
    CHECK_INT(sb_surface_ray(cube, sb_v3(REAL(NAN), 0, 0), up, 10, &hit), 0);
    CHECK_INT(sb_surface_ray(cube, o, up, REAL(NAN), &hit), 0);
    sb_surface_destroy(cube);
    sb_mesh_free(&box);
}

/* ---- moving ---- */

static void test_move(void)
{
    sb_mesh mesh = surface_organ(8);
    scene_memory memory = {0, 0, 0, 0};
    sb_allocator allocator = scene_allocator(&memory);
    sb_surface *moved = NULL, *fresh;
    sb_vec3 *nodes = mesh.nodes, *bad = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)mesh.node_count);
    unsigned long long seed = 51;
    int different = 0, calls, workers = 3;
    sb_jobs jobs = scene_jobs(&workers);
    double far_off = 0;
    CHECK_OK(sb_surface_create(&mesh, &allocator, &moved, NULL));
    calls = memory.calls;
    for (int v = 0; v < mesh.node_count; v++) {
        sb_vec3 x = nodes[v];
        nodes[v] = sb_v3(x.x * 3 + x.y, x.y * REAL(0.7) - 2 * x.z * x.z, x.z + 3 * x.x * x.x);
    }
    CHECK_OK(sb_surface_move(moved, nodes, &jobs, NULL));
    CHECK_INT(memory.calls, calls);
    memcpy(bad, nodes, sizeof(sb_vec3) * (size_t)mesh.node_count);
    bad[7].y = REAL(INFINITY);
    CHECK_RESULT(sb_surface_move(moved, bad, NULL, NULL), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_surface_move(moved, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_surface_move(NULL, nodes, NULL, NULL), SB_ERROR_ARGUMENT);
    fresh = surface_make(&mesh);
    for (int i = 0; i < 500; i++) {
        sb_vec3 p = surface_point(&mesh, 0.3, &seed), n, m;
        sb_surface_hit a, b;
        double off;
        different += sb_surface_signed_distance(moved, p, &a) != sb_surface_signed_distance(fresh, p, &b);
        different += memcmp(&a, &b, sizeof a) != 0;
        n = sb_surface_normal(moved, &a), m = sb_surface_normal(fresh, &b);
        different += memcmp(&n, &m, sizeof n) != 0;
        sb_surface_ray(moved, p, sb_v3(1, 2, 3), SB_REAL_MAX, &a);
        sb_surface_ray(fresh, p, sb_v3(1, 2, 3), SB_REAL_MAX, &b);
        different += memcmp(&a, &b, sizeof a) != 0;
        off = fabs((double)(sb_surface_winding_number(moved, p) - sb_surface_winding_number(fresh, p)));
        far_off = off > far_off ? off : far_off;
    }
    CHECK_INT(different, 0);
    CHECK_NEAR(far_off, 0, 0.05);
    sb_surface_destroy(moved);
    sb_surface_destroy(fresh);
    CHECK_INT(memory.live, 0);
    free(bad);
    sb_mesh_free(&mesh);
}

/* ---- batches ---- */

enum { SURFACE_POINTS = 700 };

static void test_batches(void)
{
    check_bad_numbers();
    static sb_surface_hit single[SURFACE_POINTS], hits[SURFACE_POINTS], signed_hits[SURFACE_POINTS];
    static sb_real distance[SURFACE_POINTS], numbers[SURFACE_POINTS], by_winding[SURFACE_POINTS];
    static unsigned char inside[SURFACE_POINTS];
    sb_mesh mesh = surface_organ(8);
    sb_surface *surface = surface_make(&mesh);
    sb_vec3 points[SURFACE_POINTS];
    unsigned long long seed = 61;
    int different = 0, missed = 0;
    sb_real reach = REAL(0.02);
    for (int i = 0; i < SURFACE_POINTS; i++)
        points[i] = surface_point(&mesh, 0.2, &seed);
    points[5].x = REAL(NAN);
    for (int workers = 0; workers < 8; workers += workers ? 3 : 1) {
        sb_jobs jobs = scene_jobs(&workers);
        const sb_jobs *use = workers ? &jobs : NULL;
        sb_surface_closest_batch(surface, points, SURFACE_POINTS, reach, hits, use);
        sb_surface_signed_distance_batch(surface, points, SURFACE_POINTS, distance, signed_hits, use);
        sb_surface_signed_distance_winding_batch(surface, points, SURFACE_POINTS, by_winding, NULL, use);
        sb_surface_winding_number_batch(surface, points, SURFACE_POINTS, numbers, use);
        sb_surface_inside_batch(surface, points, SURFACE_POINTS, inside, use);
        for (int i = 0; i < SURFACE_POINTS; i++) {
            sb_real d;
            missed += !sb_surface_closest(surface, points[i], reach, single + i);
            different += memcmp(single + i, hits + i, sizeof *hits) != 0;
            d = sb_surface_signed_distance(surface, points[i], single + i);
            different +=
                memcmp(&d, distance + i, sizeof d) != 0 || memcmp(single + i, signed_hits + i, sizeof *hits) != 0;
            d = sb_surface_signed_distance_winding(surface, points[i], NULL);
            different += memcmp(&d, by_winding + i, sizeof d) != 0;
            d = sb_surface_winding_number(surface, points[i]);
            different += memcmp(&d, numbers + i, sizeof d) != 0;
            different += sb_surface_inside(surface, points[i]) != inside[i];
        }
    }
    CHECK_INT(different, 0);
    CHECK(missed > 0);
    sb_surface_closest_batch(NULL, points, 3, reach, hits, NULL);
    sb_surface_closest_batch(surface, points, -3, reach, hits, NULL);
    sb_surface_signed_distance_batch(surface, NULL, 3, distance, NULL, NULL);
    sb_surface_inside_batch(surface, points, 3, NULL, NULL);
    sb_surface_destroy(surface);
    sb_mesh_free(&mesh);
}

/* ---- arguments ---- */

static void test_points_beyond_reason(void)
{
    sb_mesh mesh = surface_box(SB_TET4, 2, 1);
    sb_surface *surface = surface_make(&mesh);
    sb_surface_hit hit;
    sb_vec3 nan_point = sb_v3(0, REAL(NAN), 0), infinite = sb_v3(REAL(INFINITY), 0, 0), far = sb_v3(REAL(1e5), 0, 0);
    check_bad_numbers();
    sb_real d = sb_surface_signed_distance(surface, nan_point, &hit);
    CHECK(d != d);
    CHECK_INT(hit.triangle, -1);
    d = sb_surface_signed_distance(surface, infinite, &hit);
    CHECK(d != d);
    CHECK_INT(sb_surface_closest(surface, nan_point, SB_REAL_MAX, &hit), 0);
    CHECK_INT(sb_surface_closest(surface, infinite, SB_REAL_MAX, &hit), 0);
    CHECK_INT(sb_surface_closest(surface, sb_v3(0, 0, 0), REAL(NAN), &hit), 0);
    CHECK_INT(sb_surface_closest(surface, sb_v3(0, 0, 0), -1, &hit), 0);
    CHECK_INT(sb_surface_closest(surface, sb_v3(0, 0, 0), 0, &hit), 1);
    CHECK_INT(sb_surface_closest(NULL, sb_v3(0, 0, 0), 1, &hit), 0);
    CHECK_INT(hit.triangle, -1);
    CHECK(sb_surface_winding_number(surface, nan_point) == 0 &&
          sb_surface_winding_number_exact(surface, infinite) == 0);
    CHECK_INT(sb_surface_inside(surface, nan_point), 0);
    CHECK_NEAR(sb_surface_signed_distance(surface, far, NULL), 99999, 1);
    far = sb_v3(SB_REAL_MAX / 4, 0, 0);
    d = sb_surface_signed_distance(surface, far, &hit);
    CHECK(d > SB_REAL_MAX);
    CHECK_INT(hit.triangle, -1);
    CHECK_INT(sb_surface_triangle(surface, -1, NULL), -1);
    CHECK_INT(sb_surface_triangle(surface, sb_surface_triangle_count(surface), NULL), -1);
    CHECK_INT(sb_surface_triangle(surface, 0, NULL), 0);
    hit.triangle = 1 << 30;
    CHECK(sb_v3_norm(sb_surface_normal(surface, &hit)) == 0);
    CHECK(sb_surface_triangle_count(NULL) == 0 && sb_surface_node_count(NULL) == 0 && sb_surface_bytes(NULL) == 0);
    CHECK(!sb_surface_is_closed(NULL));
    sb_surface_destroy(NULL);
    sb_surface_destroy(surface);
    sb_mesh_free(&mesh);
}

static void test_creation_refuses(void)
{
    sb_mesh mesh = surface_box(SB_TET4, 1, 1), solid = scene_box(SB_TET4, 1, 1, 1, sb_v3(1, 1, 1), 0), bad = mesh;
    sb_surface *none = NULL;
    sb_error error;
    int keep;
    sb_real x;
    CHECK_RESULT(sb_surface_create(NULL, NULL, &none, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_surface_create(&mesh, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_surface_create(&solid, NULL, &none, &error), SB_ERROR_ARGUMENT);
    bad.element_count = 0;
    CHECK_RESULT(sb_surface_create(&bad, NULL, &none, &error), SB_ERROR_MESH);
    keep = mesh.elements[4];
    mesh.elements[4] = mesh.node_count;
    CHECK_RESULT(sb_surface_create(&mesh, NULL, &none, &error), SB_ERROR_INDEX);
    CHECK_INT(error.element, 1);
    mesh.elements[4] = keep;
    x = mesh.nodes[3].z;
    mesh.nodes[3].z = REAL(NAN);
    CHECK_RESULT(sb_surface_create(&mesh, NULL, &none, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.node, 3);
    mesh.nodes[3].z = SB_REAL_MAX;
    mesh.nodes[2].z = -SB_REAL_MAX;
    check_bad_numbers();
    CHECK_RESULT(sb_surface_create(&mesh, NULL, &none, &error), SB_ERROR_NOT_FINITE);
    mesh.nodes[3].z = x;
    CHECK(none == NULL);
    sb_mesh_free(&mesh);
    sb_mesh_free(&solid);
}

/* All triangles in one point, one long needle among specks, sizes at the ends of the range. */
static void test_strange_surfaces(void)
{
    sb_vec3 nodes[6] = {{1, 2, 3}, {1, 2, 3}, {1, 2, 3}, {1, 2, 3}, {1, 2, 3}, {1, 2, 3}};
    int elements[6] = {0, 1, 2, 3, 4, 5};
    sb_mesh mesh = surface_of(nodes, 6, elements, 2);
    sb_surface *surface = surface_make(&mesh);
    double ends[2];
    CHECK_NEAR(sb_surface_signed_distance(surface, sb_v3(1, 2, 5), NULL), 2, 4 * (double)SB_EPSILON);
    sb_surface_destroy(surface);
    ends[0] = SB_REAL_IS_FLOAT ? 1e-15 : 1e-150, ends[1] = SB_REAL_IS_FLOAT ? 1e15 : 1e150;
    for (int k = 0; k < 2; k++) {
        sb_mesh box = surface_box(SB_TET4, 2, 1);
        sb_real size = REAL(ends[k]);
        CHECK_OK(sb_mesh_scale(&box, size, NULL));
        surface = surface_make(&box);
        CHECK_NEAR(sb_surface_signed_distance(surface, sb_v3(size / 2, size / 4, size / 2), NULL) / size, -0.25, 1e-5);
        CHECK_NEAR(sb_surface_winding_number_exact(surface, sb_v3(size / 2, size / 4, size / 2)), 1, 1e-5);
        CHECK_INT(sb_surface_ray(surface, sb_v3(size / 2, size / 3, size / 3), sb_v3(1, 0, 0), SB_REAL_MAX, NULL), 1);
        sb_surface_destroy(surface);
        sb_mesh_free(&box);
    }
}

/* Triangles spaced so that every cut takes off one: the tree is as deep as it may get. */
static void test_deep_tree(void)
{
    enum { COUNT = 3000 };
    sb_vec3 *nodes = (sb_vec3 *)malloc(sizeof(sb_vec3) * 3 * COUNT);
    int *elements = (int *)malloc(sizeof(int) * 3 * COUNT), wrong = 0;
    sb_mesh mesh = surface_of(nodes, 3 * COUNT, elements, COUNT);
    sb_surface *surface;
    for (int t = 0; t < COUNT; t++) {
        double x = pow(0.7, t % 60) * (1 + 1e-3 * (t / 60)), h = 0.1 * x;
        nodes[3 * t] = sb_v3(REAL(x), 0, 0), nodes[3 * t + 1] = sb_v3(REAL(x + h), 0, 0),
                  nodes[3 * t + 2] = sb_v3(REAL(x), REAL(h), 0);
        for (int i = 0; i < 3; i++)
            elements[3 * t + i] = 3 * t + i;
    }
    surface = surface_make(&mesh);
    for (int i = 0; i < 40; i++) {
        sb_vec3 p = sb_v3(REAL(pow(0.7, i)), REAL(0.01), REAL(0.02));
        sb_surface_hit hit;
        wrong += !sb_surface_closest(surface, p, SB_REAL_MAX, &hit) ||
                 fabs((double)hit.distance - surface_brute(&mesh, p)) > 32 * (double)SB_EPSILON;
    }
    CHECK_INT(wrong, 0);
    sb_surface_destroy(surface);
    free(nodes);
    free(elements);
}

static void test_other_faces(void)
{
    static const sb_element_type volume[] = {SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
    static const int per[] = {4, 2, 6, 8};
    for (int k = 0; k < 4; k++) {
        sb_mesh mesh = surface_box(volume[k], 2, 1), triangles;
        sb_surface *surface = surface_make(&mesh);
        sb_surface_report report;
        int nodes[3];
        CHECK_INT(sb_surface_triangle_count(surface), mesh.element_count * per[k]);
        CHECK_INT(sb_surface_is_closed(surface), 1);
        CHECK_INT(sb_surface_triangle(surface, per[k] * 3 + 1, nodes), 3);
        CHECK_NEAR(sb_surface_signed_distance(surface, sb_v3(REAL(0.3), REAL(0.4), REAL(0.9)), NULL), -0.1,
                   8 * (double)SB_EPSILON);
        CHECK_OK(sb_surface_check(&mesh, NULL, &report, NULL));
        CHECK_INT(report.findings, 0);
        CHECK_NEAR(report.volume, 1, 100 * (double)SB_EPSILON);
        CHECK_OK(sb_surface_triangulate(&mesh, NULL, &triangles, NULL));
        CHECK_INT(triangles.element_count, mesh.element_count * per[k]);
        CHECK_OK(sb_surface_check(&triangles, NULL, &report, NULL));
        CHECK_INT(report.findings, 0);
        sb_mesh_free(&triangles);
        sb_surface_destroy(surface);
        sb_mesh_free(&mesh);
    }
}

/* ---- checks ---- */

static int surface_findings(const sb_mesh *mesh, sb_surface_report *report)
{
    sb_error error;
    memset(report, 0, sizeof *report);
    if (sb_surface_check(mesh, NULL, report, &error) != SB_OK) {
        printf("%s: %s\n", sb_result_string(error.result), error.message);
        CHECK(report->findings < 0);
    }
    return report->findings;
}

static void surface_flip(sb_mesh *mesh, int e)
{
    int keep = mesh->elements[3 * e + 1];
    mesh->elements[3 * e + 1] = mesh->elements[3 * e + 2];
    mesh->elements[3 * e + 2] = keep;
}

/* One defect at a time in a sound surface. */
static void test_check_names_defects(void)
{
    sb_mesh mesh = surface_organ(6), two;
    sb_surface_report report;
    sb_error error;
    int keep[3];
    CHECK_INT(surface_findings(&mesh, &report), 0);
    CHECK_INT(report.parts, 1);
    CHECK_NEAR(report.volume / sb_mesh_volume(&mesh), 1, 1e-5);
    CHECK_OK(sb_surface_require(&mesh, ~0, NULL, &report, &error));
    surface_flip(&mesh, 9);
    CHECK_INT(surface_findings(&mesh, &report), SB_SURFACE_FLIPPED);
    CHECK_INT(report.place[1].count, 3);
    CHECK(report.place[1].element == 9 || report.place[1].other_element == 9);
    CHECK_RESULT(sb_surface_require(&mesh, SB_SURFACE_NOT_SOLID, NULL, NULL, &error), SB_ERROR_MESH);
    CHECK(strstr(error.message, "oriented against each other") != NULL && error.element >= 0);
    CHECK_OK(sb_surface_require(&mesh, SB_SURFACE_OPEN_EDGES, NULL, NULL, &error));
    surface_flip(&mesh, 9);
    mesh.element_count--;
    CHECK_INT(surface_findings(&mesh, &report), SB_SURFACE_OPEN_EDGES);
    CHECK_INT(report.place[0].count, 3);
    CHECK(report.place[0].node >= 0 && report.place[0].other_node > report.place[0].node);
    mesh.element_count++;
    memcpy(keep, mesh.elements + 30, sizeof keep);
    mesh.elements[30] = mesh.elements[31];
    CHECK(surface_findings(&mesh, &report) & SB_SURFACE_DEGENERATE);
    CHECK_INT(report.place[4].element, 10);
    memcpy(mesh.elements + 30, mesh.elements + 33, sizeof keep);
    CHECK(surface_findings(&mesh, &report) & SB_SURFACE_DUPLICATES);
    CHECK_INT(report.place[5].element, 11);
    memcpy(mesh.elements + 30, keep, sizeof keep);
    for (int e = 0; e < mesh.element_count; e++)
        surface_flip(&mesh, e);
    CHECK_INT(surface_findings(&mesh, &report), SB_SURFACE_INSIDE_OUT);
    CHECK_INT(report.place[7].count, 1);
    for (int e = 0; e < mesh.element_count; e++)
        surface_flip(&mesh, e);
    CHECK_OK(sb_mesh_copy(&mesh, NULL, &two, NULL));
    CHECK_OK(sb_mesh_append(&two, &mesh, NULL));
    CHECK(surface_findings(&two, &report) & SB_SURFACE_UNWELDED);
    CHECK_INT(report.place[6].count, mesh.node_count);
    CHECK_INT(report.place[6].node, mesh.node_count);
    CHECK_INT(report.place[6].other_node, 0);
    CHECK_INT(report.parts, 2);
    CHECK(strcmp(sb_surface_check_string(SB_SURFACE_OPEN_EDGES), "edges of one face only") == 0);
    CHECK(strcmp(sb_surface_check_string(3), "unknown finding") == 0);
    sb_mesh_free(&two);
    sb_mesh_free(&mesh);
}

/* A cavity looks inward and is right; the same part beside the solid is not. */
static void test_check_cavity(void)
{
    sb_mesh mesh = surface_box(SB_TET4, 2, 1), hole = surface_box(SB_TET4, 1, 0.25), both;
    sb_surface_report report;
    for (int e = 0; e < hole.element_count; e++)
        surface_flip(&hole, e);
    for (int k = 0; k < 2; k++) {
        sb_real shift = k == 0 ? REAL(0.4) : REAL(2);
        for (int v = 0; v < hole.node_count; v++)
            hole.nodes[v] = sb_v3_add(hole.nodes[v], sb_v3(shift, shift, shift));
        CHECK_OK(sb_mesh_copy(&mesh, NULL, &both, NULL));
        CHECK_OK(sb_mesh_append(&both, &hole, NULL));
        CHECK_INT(surface_findings(&both, &report), SB_SURFACE_SEVERAL_PARTS | (k == 0 ? 0 : SB_SURFACE_INSIDE_OUT));
        if (k == 0) {
            sb_surface *surface = surface_make(&both);
            CHECK_OK(sb_surface_repair(&both, NULL, NULL, NULL));
            CHECK_NEAR(sb_mesh_volume(&both), 1 - 0.015625, 1e-5);
            CHECK_NEAR(sb_surface_signed_distance(surface, sb_v3(REAL(0.5), REAL(0.5), REAL(0.5)), NULL), 0.1, 1e-6);
            sb_surface_destroy(surface);
        } else {
            CHECK_INT(report.place[7].element, mesh.element_count);
        }
        sb_mesh_free(&both);
    }
    sb_mesh_free(&mesh);
    sb_mesh_free(&hole);
}

/* Crossings of two boxes: none apart or when a corner touches a side, some when one is in the other. */
static void test_check_crossings(void)
{
    static const struct {
        double shift[3];
        int crosses;
    } cases[] = {{{1.25, 0.1, 0.2}, 0}, {{0.5, 0.3, 0.1}, 1}, {{1, 0.3, 0.1}, 1}, {{0.5, 0, 0}, 1},
                 {{1, 1, 0.3}, 0},      {{1, 1, 1}, 0},       {{0, 0, 0}, 1}};
    for (size_t k = 0; k < sizeof cases / sizeof cases[0]; k++) {
        sb_mesh mesh = surface_box(SB_TET4, 2, 1), other = surface_box(SB_TET4, 2, 1);
        sb_surface_report report;
        for (int v = 0; v < other.node_count; v++)
            other.nodes[v] = sb_v3_add(
                other.nodes[v], sb_v3(REAL(cases[k].shift[0]), REAL(cases[k].shift[1]), REAL(cases[k].shift[2])));
        CHECK_OK(sb_mesh_append(&mesh, &other, NULL));
        CHECK_INT((surface_findings(&mesh, &report) & SB_SURFACE_SELF_CROSSING) != 0, cases[k].crosses);
        sb_mesh_free(&mesh);
        sb_mesh_free(&other);
    }
}

/* Triangles that share a corner or an edge: crossing through each other, folded flat, and as neighbours should be. */
static void test_check_crossing_neighbours(void)
{
    sb_vec3 nodes[7] = {{0, 0, 0},
                        {1, 0, 0},
                        {0, 1, 0},
                        {1, 1, 0},
                        {1, REAL(0.2), -1},
                        {REAL(0.3), REAL(0.5), 2},
                        {REAL(0.2), REAL(0.2), 0}};
    static const struct {
        int elements[6];
        int count;
    } cases[] = {{{0, 1, 2, 1, 3, 2}, 0},  /* flat neighbours */
                 {{0, 1, 2, 0, 5, 4}, 1},  /* through the face, from the common corner */
                 {{0, 1, 2, 3, 5, 4}, 0},  /* past it */
                 {{0, 1, 2, 1, 0, 6}, 1},  /* folded onto it */
                 {{0, 1, 2, 1, 0, 5}, 0}}; /* a roof */
    for (size_t k = 0; k < sizeof cases / sizeof cases[0]; k++) {
        int elements[6];
        sb_mesh mesh;
        sb_surface_report report;
        memcpy(elements, cases[k].elements, sizeof elements);
        mesh = surface_of(nodes, 7, elements, 2);
        surface_findings(&mesh, &report);
        CHECK_INT(report.place[8].count, cases[k].count);
    }
}

static int surface_bad_file(const char *name, sb_mesh *mesh)
{
    char path[512], file[128];
    snprintf(file, sizeof file, "data/bad/%s", name);
    if (!check_shared_path(path, sizeof path, file)) {
        CHECK_SKIP("no shared files");
        return 0;
    }
    return CHECK_OK(sb_mesh_load(mesh, path, NULL, NULL));
}

/* ---- checks: surfaces that a search of pairs would never end on ---- */

/* Triangles of their own nodes, not yet placed. */
static sb_mesh crowd_make(int count)
{
    sb_mesh mesh = surface_of((sb_vec3 *)calloc((size_t)count * 3, sizeof(sb_vec3)), 3 * count,
                              (int *)malloc(sizeof(int) * 3 * (size_t)count), count);
    for (int i = 0; i < 3 * count; i++)
        mesh.elements[i] = i;
    return mesh;
}

static void crowd_free(sb_mesh *mesh)
{
    free(mesh->nodes);
    free(mesh->elements);
}

/* Each of these took seconds to minutes when all pairs were looked at. What is wrong is named all the same. */
static void test_check_crowds(void)
{
    enum { COUNT = 12000 };
    static const int expected[] = {
        SB_SURFACE_SELF_CROSSING | SB_SURFACE_UNWELDED | SB_SURFACE_OPEN_EDGES | SB_SURFACE_SEVERAL_PARTS,
        SB_SURFACE_DUPLICATES | SB_SURFACE_NONMANIFOLD_EDGES,
        /* float cannot tell the sheets apart */
        (sizeof(sb_real) == 4 ? (int)SB_SURFACE_SELF_CROSSING : (int)SB_SURFACE_CROWDED) | SB_SURFACE_OPEN_EDGES |
            SB_SURFACE_SEVERAL_PARTS,
        SB_SURFACE_NONMANIFOLD_EDGES | SB_SURFACE_OPEN_EDGES,
        SB_SURFACE_SELF_CROSSING | SB_SURFACE_OPEN_EDGES | SB_SURFACE_NONMANIFOLD_NODES,
        SB_SURFACE_SELF_CROSSING | SB_SURFACE_OPEN_EDGES | SB_SURFACE_SEVERAL_PARTS,
    };
    static const char *const names[] = {"coincident",      "the same nodes", "stacked",
                                        "pages of a book", "crossing fan",   "slivers through one point"};
    for (int k = 0; k < 6; k++) {
        sb_mesh mesh = crowd_make(COUNT);
        sb_surface_report report;
        unsigned long long seed = 3;
        for (int t = 0; t < COUNT; t++) {
            sb_vec3 *x = mesh.nodes + 3 * t;
            int *e = mesh.elements + 3 * t;
            double a = 2 * SURFACE_PI * t / (double)COUNT, h = 1e-3 * check_random_in(&seed, 0, 1);
            sb_real z = k == 2 ? REAL(1e-11 * t) : 0;
            x[t % 3] = sb_v3(0, 0, z), x[(t + 1) % 3] = sb_v3(1, 0, z), x[(t + 2) % 3] = sb_v3(0, 1, z);
            if (k == 1)
                e[0] = t % 3, e[1] = (1 + t) % 3, e[2] = (2 + t) % 3;
            if (k == 3 || k == 4)
                e[0] = 0;
            if (k == 3)
                e[1] = 1, x[2] = sb_v3(REAL(cos(a)), REAL(sin(a)), REAL(0.5));
            if (k == 4)
                x[1] = sb_v3(REAL(cos(a)), REAL(sin(a)), 0), x[2] = sb_v3(REAL(cos(a + 1)), REAL(sin(a + 1)), 0);
            if (k == 5) {
                x[0] = sb_v3(REAL(cos(a)), REAL(sin(a)), REAL(h)), x[1] = sb_v3(REAL(-cos(a)), REAL(-sin(a)), REAL(-h));
                x[2] = sb_v3_add(x[1], sb_v3(0, 0, REAL(0.01)));
            }
        }
        if (k == 3)
            mesh.nodes[0] = sb_v3(0, 0, 0), mesh.nodes[1] = sb_v3(0, 0, 1);
        CHECK_OK(sb_surface_check(&mesh, NULL, &report, NULL));
        if ((report.findings & expected[k]) != expected[k])
            printf("%s: findings %d\n", names[k], report.findings);
        CHECK_INT(report.findings & expected[k], expected[k]);
        CHECK_INT(report.crossings_partial, 1);
        CHECK_RESULT(sb_surface_require(&mesh, SB_SURFACE_SELF_CROSSING | SB_SURFACE_CROWDED, NULL, NULL, NULL),
                     SB_ERROR_MESH);
        crowd_free(&mesh);
    }
}

/* Corner i of n on a ring, turned out of the axes so that boxes fit badly. */
static sb_vec3 turned_ring(int i, int n, double radius, double height)
{
    double a = 2 * SURFACE_PI * i / n, x = radius * cos(a), y = radius * sin(a), c = 0.6, s = 0.8;
    double u = c * x + s * height, w = c * height - s * x;
    return sb_v3(REAL(c * u - s * y), REAL(s * u + c * y), REAL(w));
}

/* Sound surfaces with fans of thousands of triangles and long slivers side by side: a bipyramid, and a needle with
 * caps. Nothing is wrong with them; one triangle pushed through its neighbours is found. */
static void test_check_large_fans(void)
{
    const int N = sizeof(sb_real) == 4 ? 300 : 3000; /* slivers that have two sides also in float */
    const double H = sizeof(sb_real) == 4 ? 2 : 40;
    for (int k = 0; k < 2; k++) {
        sb_mesh mesh = crowd_make(k == 0 ? 2 * N : 4 * N);
        sb_surface_report report;
        mesh.node_count = k == 0 ? N + 2 : 2 * N + 2;
        for (int i = 0; i < N; i++) {
            int j = (i + 1) % N, *e = mesh.elements + (k == 0 ? 6 : 12) * i;
            int side[12] = {0, 2 + i, 2 + j, 1, 2 + j, 2 + i, N + 2 + i, 2 + j, 2 + i, N + 2 + i, N + 2 + j, 2 + j};
            mesh.nodes[2 + i] = turned_ring(i, N, 1, k == 0 ? 0 : H);
            if (k == 1)
                mesh.nodes[N + 2 + i] = turned_ring(i, N, 1, -H), side[4] = N + 2 + j, side[5] = N + 2 + i;
            memcpy(e, side, sizeof(int) * (k == 0 ? 6 : 12));
        }
        mesh.nodes[0] = turned_ring(0, N, 0, k == 0 ? 2 : H);
        mesh.nodes[1] = turned_ring(0, N, 0, k == 0 ? -2 : -H);
        CHECK_OK(sb_surface_check(&mesh, NULL, &report, NULL));
        CHECK_INT(report.findings, 0);
        CHECK_NEAR(report.volume, k == 0 ? 4 * SURFACE_PI / 3 : 2 * H * SURFACE_PI, 1e-3 * (double)report.volume);
        mesh.nodes[2 + N / 2] = turned_ring(N / 2 + 7, N, 0.9995, k == 0 ? 0 : H);
        mesh.nodes[3 + N / 2] = turned_ring(N / 2 + 9, N, 1.0005, k == 0 ? 0 : H);
        CHECK_OK(sb_surface_check(&mesh, NULL, &report, NULL));
        CHECK(report.findings & SB_SURFACE_SELF_CROSSING);
        CHECK_INT(report.crossings_partial, 0);
        crowd_free(&mesh);
    }
}

/* As many crossings as one finds taking two triangles at a time, whether they share a node with a hundred or not. */
static void test_check_crossing_count(void)
{
    for (int k = 0; k < 4; k++) {
        enum { COUNT = 100 };
        sb_mesh mesh = crowd_make(COUNT), two = mesh;
        sb_surface_report report;
        unsigned long long seed = 11 + (unsigned long long)k;
        int pairs = 0;
        for (int t = 0; t < COUNT; t++) {
            double middle[3], size = k < 2 ? 0.5 : 0.25;
            for (int i = 0; i < 3; i++)
                middle[i] = check_random_in(&seed, -1, 1);
            for (int i = 0; i < 3; i++)
                mesh.nodes[3 * t + i] = sb_v3(REAL(middle[0] + check_random_in(&seed, -size, size)),
                                              REAL(middle[1] + check_random_in(&seed, -size, size)),
                                              REAL(middle[2] + check_random_in(&seed, -size, size)));
            if (k % 2)
                mesh.elements[3 * t + t % 3] = 0;
        }
        CHECK_OK(sb_surface_check(&mesh, NULL, &report, NULL));
        for (int t = 0; t < COUNT; t++)
            for (int u = t + 1; u < COUNT; u++) {
                int both[6];
                sb_surface_report found;
                memcpy(both, mesh.elements + 3 * t, 3 * sizeof(int));
                memcpy(both + 3, mesh.elements + 3 * u, 3 * sizeof(int));
                two.elements = both;
                two.element_count = 2;
                CHECK_OK(sb_surface_check(&two, NULL, &found, NULL));
                pairs += found.place[8].count;
            }
        CHECK(pairs > 10);
        CHECK_INT(report.place[8].count, pairs);
        CHECK_INT(report.crossings_partial, 0);
        crowd_free(&mesh);
    }
}

/* Thousands of loose parts, every second one inside out: each is named, and a repair turns it. */
static void test_check_many_parts(void)
{
    enum { PARTS = 6000 };
    static const int faces[12] = {0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2};
    sb_mesh mesh, made = crowd_make(4 * PARTS);
    sb_surface_report report;
    made.node_count = 4 * PARTS;
    for (int p = 0; p < PARTS; p++) {
        double x = p % 20, y = p / 20 % 20, z = p / 400;
        for (int v = 0; v < 4; v++)
            made.nodes[4 * p + v] = sb_v3(REAL(x + 0.5 * (v == 1)), REAL(y + 0.5 * (v == 2)), REAL(z + 0.5 * (v == 3)));
        for (int i = 0; i < 12; i++)
            made.elements[12 * p + i] = 4 * p + (p % 2 ? faces[11 - i] : faces[i]);
    }
    CHECK_INT(surface_findings(&made, &report), SB_SURFACE_SEVERAL_PARTS | SB_SURFACE_INSIDE_OUT);
    CHECK_INT(report.place[7].count, PARTS / 2);
    CHECK_INT(report.place[7].element, 4);
    CHECK_OK(sb_mesh_copy(&made, NULL, &mesh, NULL));
    CHECK_OK(sb_surface_repair(&mesh, NULL, NULL, NULL));
    CHECK_INT(surface_findings(&mesh, &report), SB_SURFACE_SEVERAL_PARTS);
    sb_mesh_free(&mesh);
    crowd_free(&made);
}

static void test_check_bad_files(void)
{
    static const struct {
        const char *name;
        int findings; /* these at least */
    } cases[] = {{"open_surface.obj", SB_SURFACE_OPEN_EDGES},
                 {"inside_out.obj", SB_SURFACE_INSIDE_OUT},
                 {"mixed_orientation.obj", SB_SURFACE_FLIPPED},
                 {"nonmanifold_edge_fin.obj", SB_SURFACE_NONMANIFOLD_EDGES | SB_SURFACE_OPEN_EDGES},
                 {"nonmanifold_vertex_bowtie.obj", SB_SURFACE_NONMANIFOLD_NODES},
                 {"self_intersecting.obj", SB_SURFACE_SELF_CROSSING | SB_SURFACE_SEVERAL_PARTS},
                 {"degenerate_triangle.obj", SB_SURFACE_DEGENERATE}};
    for (size_t k = 0; k < sizeof cases / sizeof cases[0]; k++) {
        sb_mesh mesh;
        sb_surface_report report;
        sb_error error;
        if (!surface_bad_file(cases[k].name, &mesh))
            return;
        surface_findings(&mesh, &report);
        CHECK_INT(report.findings & cases[k].findings, cases[k].findings);
        CHECK_RESULT(sb_surface_require(&mesh, cases[k].findings, NULL, NULL, &error), SB_ERROR_MESH);
        CHECK(error.element >= 0 || error.node >= 0);
        sb_mesh_free(&mesh);
    }
}

/* ---- repairs ---- */

/* A soup of triangles with their own nodes, every third turned round: welded and oriented it is the surface again. */
static void test_repair_soup(void)
{
    sb_mesh mesh = surface_organ(6), soup;
    sb_surface_repair_report done;
    sb_surface_report report;
    memset(&soup, 0, sizeof soup);
    soup.element_type = SB_TRI3;
    soup.node_count = 3 * mesh.element_count;
    soup.element_count = mesh.element_count;
    soup.nodes = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)soup.node_count);
    soup.elements = (int *)malloc(sizeof(int) * (size_t)soup.node_count);
    for (int i = 0; i < soup.node_count; i++) {
        soup.nodes[i] = mesh.nodes[mesh.elements[i]];
        soup.elements[i] = i;
    }
    for (int e = 0; e < soup.element_count; e += 3)
        surface_flip(&soup, e);
    CHECK(surface_findings(&soup, &report) & SB_SURFACE_OPEN_EDGES);
    CHECK_OK(sb_surface_repair(&soup, NULL, &done, NULL));
    CHECK_INT(done.merged_nodes, 3 * mesh.element_count - mesh.node_count);
    CHECK_INT(done.turned_faces, (mesh.element_count + 2) / 3);
    CHECK_INT(done.left_holes, -1);
    CHECK_INT(surface_findings(&soup, &report), 0);
    CHECK_NEAR(sb_mesh_volume(&soup) / sb_mesh_volume(&mesh), 1, scene_tolerance(1e-12, 100));
    sb_mesh_free(&soup);
    sb_mesh_free(&mesh);
}

static void test_repair_degenerate(void)
{
    sb_vec3 nodes[9];
    int elements[45];
    sb_mesh borrowed = surface_with_flat_triangle(nodes, elements), mesh;
    sb_surface_repair_report done;
    sb_surface_report report;
    elements[42] = elements[43] = 3, elements[44] = 5;
    borrowed.element_count = 15;
    CHECK_OK(sb_mesh_copy(&borrowed, NULL, &mesh, NULL));
    CHECK_OK(sb_surface_repair(&mesh, NULL, &done, NULL));
    CHECK_INT(done.removed_degenerate, 1);
    CHECK_INT(done.flipped_edges, 1);
    CHECK_INT(mesh.element_count, 14);
    CHECK_INT(surface_findings(&mesh, &report), 0);
    CHECK_NEAR(sb_mesh_volume(&mesh), 1, 16 * (double)SB_EPSILON);
    sb_mesh_free(&mesh);
}

static void test_repair_holes(void)
{
    sb_mesh mesh = surface_box(SB_TET4, 4, 1);
    sb_surface_repair_def def = sb_default_surface_repair();
    sb_surface_repair_report done;
    sb_surface_report report;
    int kept = 0, removed;
    /* the four cells in the middle of the top, and one triangle of the bottom */
    for (int e = 0; e < mesh.element_count; e++) {
        const int *nodes = mesh.elements + 3 * e;
        int top = 0, bottom = 0;
        for (int i = 0; i < 3; i++) {
            sb_vec3 x = mesh.nodes[nodes[i]];
            top += x.z == 1 && x.x > REAL(0.2) && x.x < REAL(0.8) && x.y > REAL(0.2) && x.y < REAL(0.8);
            bottom += x.z == 0;
        }
        if (top == 3 || (bottom == 3 && kept == e))
            bottom = -1;
        if (bottom == -1 && (top == 3 || e == kept))
            continue;
        memmove(mesh.elements + 3 * kept++, nodes, 3 * sizeof(int));
    }
    removed = mesh.element_count - kept;
    CHECK(removed > 8);
    mesh.element_count = kept;
    CHECK_INT(surface_findings(&mesh, &report) & SB_SURFACE_OPEN_EDGES, SB_SURFACE_OPEN_EDGES);
    def.max_hole_edges = 3;
    CHECK_OK(sb_surface_repair(&mesh, &def, &done, NULL));
    CHECK(done.left_holes >= 1);
    CHECK(surface_findings(&mesh, &report) & SB_SURFACE_OPEN_EDGES);
    def.max_hole_edges = 200;
    CHECK_OK(sb_surface_repair(&mesh, &def, &done, NULL));
    CHECK_INT(done.left_holes, 0);
    CHECK(done.filled_holes >= 1 && done.added_faces >= 6);
    CHECK_INT(surface_findings(&mesh, &report) & ~SB_SURFACE_SEVERAL_PARTS, 0);
    CHECK_NEAR(sb_mesh_volume(&mesh), 1, 100 * (double)SB_EPSILON);
    CHECK_NEAR(sb_mesh_surface_area(&mesh), 6, 100 * (double)SB_EPSILON);
    def.max_hole_edges = 300;
    CHECK_RESULT(sb_surface_repair(&mesh, &def, &done, NULL), SB_ERROR_ARGUMENT);
    def.max_hole_edges = 10;
    def.weld_tolerance = REAL(NAN);
    CHECK_RESULT(sb_surface_repair(&mesh, &def, &done, NULL), SB_ERROR_ARGUMENT);
    sb_mesh_free(&mesh);
}

static void test_repair_refuses(void)
{
    sb_vec3 nodes[6] = {{1, 0, 0}, {0, 1, 0}, {-1, 0, 0}, {1, 0, 1}, {0, 1, 1}, {-1, 0, 1}};
    int moebius[18] = {0, 1, 3, 1, 4, 3, 1, 2, 4, 2, 5, 4, 2, 3, 5, 3, 0, 5}, before[18];
    sb_mesh mesh = surface_of(nodes, 6, moebius, 6), quads = surface_box(SB_HEX8, 1, 1);
    sb_surface_repair_report done;
    sb_error error;
    memcpy(before, moebius, sizeof before);
    CHECK_RESULT(sb_surface_repair(&mesh, NULL, &done, &error), SB_ERROR_MESH);
    CHECK(strstr(error.message, "one-sided") != NULL);
    CHECK(memcmp(before, moebius, sizeof before) == 0 && mesh.elements == moebius && mesh.nodes == nodes);
    for (int i = 0; i < 18; i++)
        moebius[i] = i % 2;
    CHECK_RESULT(sb_surface_repair(&mesh, NULL, &done, &error), SB_ERROR_MESH);
    CHECK_RESULT(sb_surface_repair(&quads, NULL, &done, &error), SB_ERROR_UNSUPPORTED);
    CHECK_RESULT(sb_surface_repair(NULL, NULL, &done, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_surface_check(&quads, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_surface_triangulate(&quads, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    sb_mesh_free(&quads);
}

static void test_repair_bad_files(void)
{
    static const char *names[] = {"inside_out.obj", "mixed_orientation.obj", "degenerate_triangle.obj",
                                  "open_surface.obj"};
    for (int k = 0; k < 4; k++) {
        sb_mesh mesh;
        sb_surface_report report;
        sb_surface_repair_def def = sb_default_surface_repair();
        def.max_hole_edges = 64;
        if (!surface_bad_file(names[k], &mesh))
            return;
        CHECK_OK(sb_surface_repair(&mesh, &def, NULL, NULL));
        CHECK_INT(surface_findings(&mesh, &report) & SB_SURFACE_NOT_SOLID, 0);
        CHECK(report.volume > 0);
        sb_mesh_free(&mesh);
    }
}

/* ---- memory ---- */

static void test_memory_runs_out(void)
{
    sb_mesh mesh = surface_box(SB_TET4, 2, 1), copy;
    int stage, fail;
    mesh.element_count--; /* a hole to fill */
    surface_flip(&mesh, 3);
    for (stage = 0; stage < 4; stage++) {
        for (fail = 1; fail < 400; fail++) {
            scene_memory memory = {0, 0, 0, 0};
            sb_allocator allocator = scene_allocator(&memory);
            sb_surface *surface = NULL;
            sb_surface_report report;
            sb_surface_repair_def def = sb_default_surface_repair();
            sb_error error;
            sb_result result;
            memset(&copy, 0, sizeof copy);
            def.max_hole_edges = 10;
            if (stage == 3)
                CHECK_OK(sb_mesh_copy(&mesh, &allocator, &copy, NULL));
            memory.fail_at = memory.calls + fail;
            if (stage == 0)
                result = sb_surface_create(&mesh, &allocator, &surface, &error);
            else if (stage == 1)
                result = sb_surface_check(&mesh, &allocator, &report, &error);
            else if (stage == 2)
                result = sb_surface_triangulate(&mesh, &allocator, &copy, &error);
            else
                result = sb_surface_repair(&copy, &def, NULL, &error);
            if (result != SB_OK)
                CHECK_RESULT(result, SB_ERROR_MEMORY);
            if (stage == 3 && result != SB_OK)
                CHECK_INT(copy.element_count, mesh.element_count);
            sb_surface_destroy(surface);
            sb_mesh_free(&copy);
            CHECK_INT(memory.live, 0);
            if (result == SB_OK)
                break;
        }
        CHECK(fail > 2 && fail < 400);
    }
    sb_mesh_free(&mesh);
}

CHECK_SUITE(surface, {"closest point by brute force", test_closest_brute_force},
            {"closest point at any scale", test_closest_scales},
            {"closest point is the least", test_closest_is_the_least}, {"features", test_features}, {"cube", test_cube},
            {"signs", test_signs}, {"signs of shared surfaces", test_signs_of_shared_surfaces},
            {"degenerate triangles", test_degenerate_triangles}, {"slivers", test_slivers},
            {"winding number of an open box", test_winding_number_of_open_box},
            {"winding number of an overlap", test_winding_number_of_overlap},
            {"rays by brute force", test_rays_brute_force}, {"rays are watertight", test_rays_are_watertight},
            {"ray arguments", test_ray_arguments}, {"move", test_move}, {"batches", test_batches},
            {"points beyond reason", test_points_beyond_reason}, {"creation refuses", test_creation_refuses},
            {"strange surfaces", test_strange_surfaces}, {"deep tree", test_deep_tree},
            {"other faces", test_other_faces}, {"check names defects", test_check_names_defects},
            {"check knows cavities", test_check_cavity}, {"check counts crossings", test_check_crossings},
            {"check crossing neighbours", test_check_crossing_neighbours}, {"check crowds", test_check_crowds},
            {"check large fans", test_check_large_fans}, {"check crossing count", test_check_crossing_count},
            {"check many parts", test_check_many_parts}, {"check bad files", test_check_bad_files},
            {"repair of a soup", test_repair_soup}, {"repair of degenerate triangles", test_repair_degenerate},
            {"repair of holes", test_repair_holes}, {"repair refuses", test_repair_refuses},
            {"repair of bad files", test_repair_bad_files}, {"memory runs out", test_memory_runs_out});
