/* Tests of field: distances to surfaces and clouds against brute force, rims, derivatives by differences, Laplace. */
#include "check.h"
#include "scene.h"

#include "register.h"

enum { ROWS = 24, COLUMNS = 48 };

/* A sphere of radius 1 about the origin, of ROWS bands between the poles; its lower part left away when cap is 1. */
static sb_mesh sphere(int cap)
{
    sb_mesh mesh;
    const double pi = 3.14159265358979;
    int bands = cap ? ROWS / 3 : ROWS, at = 0;
    memset(&mesh, 0, sizeof mesh);
    mesh.element_type = SB_TRI3;
    mesh.node_count = (bands + 1) * COLUMNS;
    mesh.nodes = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
    mesh.elements = (int *)malloc((size_t)(6 * bands * COLUMNS) * sizeof(int));
    for (int i = 0; i <= bands; i++)
        for (int j = 0; j < COLUMNS; j++) {
            double a = pi * i / (int)ROWS, b = 2 * pi * j / (int)COLUMNS;
            mesh.nodes[i * COLUMNS + j] = sb_v3(REAL(sin(a) * cos(b)), REAL(sin(a) * sin(b)), REAL(cos(a)));
        }
    for (int i = 0; i < bands; i++)
        for (int j = 0; j < COLUMNS; j++) {
            int a = i * COLUMNS + j, b = i * COLUMNS + (j + 1) % COLUMNS, c = a + COLUMNS, d = b + COLUMNS;
            const int both[6] = {a, c, b, b, c, d};
            for (int k = 0; k < 6; k++) /* at the poles one of the two is flat */
                if ((i > 0 || k > 2) && (i < ROWS - 1 || k < 3))
                    mesh.elements[at++] = both[k];
        }
    mesh.element_count = at / 3;
    (void)sb_mesh_merge_nodes(&mesh, REAL(1e-6), NULL, NULL);
    return mesh;
}

static reg_field *make_field(const reg_field_def *def)
{
    reg_field *field = NULL;
    sb_error error;
    if (!CHECK_OK(reg_field_create(def, &field, &error)))
        printf("%s\n", error.message);
    return field;
}

static sb_vec3 random_point(unsigned long long *seed, double size)
{
    double x = check_random_in(seed, -size, size), y = check_random_in(seed, -size, size);
    return sb_v3(REAL(x), REAL(y), REAL(check_random_in(seed, -size, size)));
}

static void test_sphere(void)
{
    sb_mesh mesh = sphere(0);
    reg_field_def def = reg_default_field_def();
    reg_field *field;
    unsigned long long seed = 3;
    def.surface = &mesh;
    field = make_field(&def);
    for (int i = 0; field && i < 300; i++) {
        sb_vec3 p = random_point(&seed, 2), gradient;
        sb_real r = sb_v3_norm(p), phi;
        reg_field_hit hit, again;
        CHECK(reg_field_closest(field, p, -1, &hit) && reg_field_closest(field, p, 7, &again));
        CHECK(hit.distance == again.distance && hit.item == again.item && !hit.on_border);
        CHECK_NEAR(hit.distance, fabs((double)r - 1), 0.012); /* of facets of 7.5 degrees */
        CHECK(sb_v3_dot(hit.normal, hit.point) > REAL(0.98));
        CHECK(reg_field_at(field, p, hit.item, &phi, &gradient) && phi == hit.distance);
        if (r > REAL(0.3) && fabs((double)r - 1) > 0.05) /* the gradient of facets differs near centre and surface */
            CHECK_NEAR(sb_v3_dot(gradient, p), r > 1 ? r : -r, 0.12 * (double)r);
    }
    reg_field_destroy(field);
    sb_mesh_free(&mesh);
}

/* Only the rim of a cap is its border, and only points beyond it find it. */
static void test_rim(void)
{
    sb_mesh mesh = sphere(1);
    reg_field_def def = reg_default_field_def();
    reg_field *field, *cloud;
    unsigned long long seed = 4;
    int beyond = 0;
    def.surface = &mesh;
    field = make_field(&def);
    def.surface = NULL;
    def.points = mesh.nodes;
    def.point_count = mesh.node_count;
    cloud = make_field(&def);
    for (int i = 0; field && cloud && i < 300; i++) {
        sb_vec3 p = random_point(&seed, 1.5);
        sb_real height = p.z / sb_v3_norm(p);
        reg_field_hit hit, near;
        if (fabs((double)height - 0.5) < 0.06 || sb_v3_norm(p) < REAL(0.1))
            continue; /* within half a facet of the rim */
        CHECK(reg_field_closest(field, p, -1, &hit) && reg_field_closest(cloud, p, -1, &near));
        CHECK_INT(hit.on_border, height < REAL(0.5) && sb_v3_norm(p) > REAL(0.1) && hit.point.z < REAL(0.51));
        CHECK(near.distance >= hit.distance * (1 - 8 * SB_EPSILON) && near.distance < hit.distance + REAL(0.15));
        beyond += near.on_border;
        if (height > REAL(0.7))
            CHECK(!near.on_border);
        if (height < REAL(0.2))
            CHECK(near.on_border);
    }
    CHECK(beyond > 100);
    reg_field_destroy(field);
    reg_field_destroy(cloud);
    sb_mesh_free(&mesh);
}

/* phi_n and phi_nn against their definition and against differences of phi_n. */
static void test_slopes(void)
{
    sb_mesh mesh = sphere(0);
    unsigned long long seed = 5;
    const double step = 0.2, eps = sizeof(sb_real) == 8 ? 1e-6 : 4e-3;
    for (int kind = 0; kind < 2; kind++) {
        reg_field_def def = reg_default_field_def();
        reg_field *field;
        int smooth = 0;
        def.surface = &mesh;
        def.kind = kind ? REG_FIELD_LAPLACE : REG_FIELD_DISTANCE;
        def.cells = 16;
        field = make_field(&def);
        for (int i = 0; field && i < 200; i++) {
            sb_vec3 p = random_point(&seed, 1.2), n = random_point(&seed, 1);
            reg_field_sample at, more, less;
            sb_real a, b, phi;
            double slope;
            n = sb_v3_scale(1 / sb_v3_norm(n), n);
            CHECK(reg_field_along(field, p, n, REAL(step), -1, &at));
            CHECK(reg_field_at(field, sb_v3_madd(p, REAL(step / 2), n), -1, &a, NULL));
            CHECK(reg_field_at(field, sb_v3_madd(p, REAL(-step / 2), n), -1, &b, NULL));
            CHECK(reg_field_at(field, p, -1, &phi, NULL) && phi == at.phi);
            CHECK_NEAR(at.phi_n, (a - b) / REAL(step), 64 * (double)SB_EPSILON / step);
            CHECK(reg_field_along(field, sb_v3_madd(p, REAL(eps), n), n, REAL(step), -1, &more));
            CHECK(reg_field_along(field, sb_v3_madd(p, REAL(-eps), n), n, REAL(step), -1, &less));
            slope = (double)(more.phi_n - less.phi_n) / (2 * eps);
            /* not across a crease or a cell's side */
            smooth += fabs(slope - (double)at.phi_nn) < 0.02 * (1 + fabs(slope));
        }
        CHECK(smooth > (sizeof(sb_real) == 8 ? 195 : 140));
        reg_field_destroy(field);
    }
    sb_mesh_free(&mesh);
}

/* Harmonic away from target and box, within the bounds of its data, 0 inside a closed target. */
static void test_laplace(void)
{
    sb_mesh mesh = sphere(0);
    reg_field_def def = reg_default_field_def();
    reg_field *field;
    sb_vec3 low, high, size;
    sb_real cell, margin, phi, most = 0;
    unsigned long long seed = 6;
    def.surface = &mesh;
    def.kind = REG_FIELD_LAPLACE;
    def.cells = 32;
    field = make_field(&def);
    if (!field)
        return;
    CHECK(reg_field_sweeps(field) > 10 && reg_field_sweeps(field) < 300);
    reg_field_bounds(field, &low, &high);
    size = sb_v3_sub(high, low);
    margin = REAL(0.1) * sb_v3_norm(size);
    cell = (sb_max(size.x, sb_max(size.y, size.z)) + 2 * margin) / 32;
    low = sb_v3_sub(low, sb_v3(margin, margin, margin));
    for (int i = 2; i < 6; i++)
        for (int j = 2; j < 6; j++) { /* a corner of the box, far from the sphere */
            sb_vec3 x = sb_v3_madd(low, cell, sb_v3(REAL(i), REAL(j), 3));
            double sum = 0;
            for (int k = 0; k < 6; k++) {
                sb_real side = k % 2 ? cell : -cell;
                CHECK(reg_field_at(
                    field, sb_v3_add(x, sb_v3(k / 2 == 0 ? side : 0, k / 2 == 1 ? side : 0, k / 2 == 2 ? side : 0)), -1,
                    &phi, NULL));
                sum += (double)phi / 6;
            }
            CHECK(reg_field_at(field, x, -1, &phi, NULL));
            CHECK_NEAR(phi, sum, 1e-3 * (double)cell);
            CHECK(phi > 0);
        }
    for (int i = 0; i < 200; i++) {
        sb_vec3 p = random_point(&seed, 3);
        CHECK(reg_field_at(field, p, -1, &phi, NULL) && phi >= 0);
        if (sb_v3_norm(p) < REAL(0.95))
            most = sb_max(most, phi);
    }
    CHECK(most < cell);
    CHECK(!reg_field_at(field, sb_v3(REAL(NAN), 0, 0), -1, &phi, NULL));
    reg_field_destroy(field);
    sb_mesh_free(&mesh);
}

static void test_cloud(void)
{
    unsigned long long seed = 8;
    sb_vec3 points[200], normals[200];
    reg_field_def def = reg_default_field_def();
    reg_field *field;
    for (int i = 0; i < 200; i++) {
        points[i] = random_point(&seed, 1);
        normals[i] = i % 3 ? sb_v3_scale(REAL(1 + i), points[i]) : sb_v3(0, 0, 0);
    }
    def.points = points;
    def.normals = normals;
    def.point_count = 200;
    field = make_field(&def);
    for (int i = 0; field && i < 200; i++) {
        sb_vec3 p = random_point(&seed, 2);
        reg_field_hit hit;
        int best = 0;
        for (int k = 1; k < 200; k++)
            if (sb_v3_norm(sb_v3_sub(p, points[k])) < sb_v3_norm(sb_v3_sub(p, points[best])))
                best = k;
        CHECK(reg_field_closest(field, p, -1, &hit));
        CHECK_INT(hit.item, best);
        CHECK_NEAR(sb_v3_norm(hit.normal), best % 3 != 0, 8 * (double)SB_EPSILON);
    }
    if (field)
        CHECK(reg_field_sweeps(field) == 0);
    reg_field_destroy(field);
    def.point_count = 1; /* one point is a target, if a poor one */
    field = make_field(&def);
    reg_field_destroy(field);
}

static void test_refusals(void)
{
    sb_mesh mesh = sphere(0);
    sb_vec3 points[2] = {{0, 0, 0}, {0, REAL(NAN), 0}};
    reg_field_def def = reg_default_field_def(), bad;
    reg_field *field = NULL;
    sb_error error;
    CHECK(reg_field_create(NULL, &field, &error) == SB_ERROR_ARGUMENT);
    CHECK(reg_field_create(&def, &field, &error) == SB_ERROR_ARGUMENT); /* no target */
    def.surface = &mesh;
    CHECK(reg_field_create(&def, NULL, &error) == SB_ERROR_ARGUMENT);
    bad = def;
    bad.points = points;
    CHECK(reg_field_create(&bad, &field, &error) == SB_ERROR_ARGUMENT); /* two */
    bad.surface = NULL;
    CHECK(reg_field_create(&bad, &field, &error) == SB_ERROR_ARGUMENT); /* no points */
    bad.point_count = 2;
    CHECK(reg_field_create(&bad, &field, &error) == SB_ERROR_NOT_FINITE && error.node == 1);
    bad.points = points;
    bad.point_count = 1;
    bad.normals = points + 1;
    CHECK(reg_field_create(&bad, &field, &error) == SB_ERROR_NOT_FINITE && error.node == 0);
    bad = def;
    bad.cells = 7;
    CHECK(reg_field_create(&bad, &field, &error) == SB_ERROR_ARGUMENT);
    bad = def;
    bad.low = sb_v3(1, 0, 0);
    CHECK(reg_field_create(&bad, &field, &error) == SB_ERROR_ARGUMENT);
    bad.high = sb_v3(1, 0, REAL(INFINITY));
    CHECK(reg_field_create(&bad, &field, &error) == SB_ERROR_NOT_FINITE);
    bad = def;
    bad.cookie = 0;
    CHECK(reg_field_create(&bad, &field, &error) == SB_ERROR_ARGUMENT);
    CHECK(field == NULL);
    reg_field_destroy(NULL);
    sb_mesh_free(&mesh);
}

static void test_memory(void)
{
    sb_mesh mesh = sphere(1);
    for (int kind = 0; kind < 3; kind++) {
        reg_field_def def = reg_default_field_def();
        scene_memory memory = {0, 0, 0, 0};
        sb_result result = SB_ERROR_MEMORY;
        def.allocator = scene_allocator(&memory);
        def.cells = 8;
        def.kind = kind == 1 ? REG_FIELD_LAPLACE : REG_FIELD_DISTANCE;
        def.surface = kind < 2 ? &mesh : NULL;
        def.points = def.normals = kind < 2 ? NULL : mesh.nodes;
        def.point_count = mesh.node_count;
        for (int fail = 1; result == SB_ERROR_MEMORY && fail < 1000; fail++) {
            reg_field *field = NULL;
            memory.calls = 0;
            memory.fail_at = fail;
            result = reg_field_create(&def, &field, NULL);
            CHECK(result == SB_OK || (result == SB_ERROR_MEMORY && field == NULL && memory.live == 0));
            reg_field_destroy(field);
            CHECK_INT(memory.live, 0);
        }
        CHECK_OK(result);
    }
    sb_mesh_free(&mesh);
}

CHECK_SUITE(field, {"distance to a sphere", test_sphere}, {"rims", test_rim}, {"slopes by differences", test_slopes},
            {"Laplace's potential", test_laplace}, {"clouds by brute force", test_cloud}, {"refusals", test_refusals},
            {"failing allocations", test_memory});
