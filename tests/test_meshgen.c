/* meshgen: generated solids are conforming, sound, and have the right size. */
#include "softbody.h"

#include <limits.h>

#include "check.h"

static const sb_element_type meshgen_types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
enum { MESHGEN_TYPES = 5 };
static int meshgen_is_hex(int t) { return sb_element_corner_count(meshgen_types[t]) == 8; }
static int meshgen_is_quadratic(sb_element_type type)
{
    return sb_element_node_count(type) > sb_element_corner_count(type);
}
#define GREAL(x) ((sb_real)(x))
static double meshgen_eps(double factor) { return factor * (double)SB_EPSILON; }

static sb_mesh meshgen_none(void)
{
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    return mesh;
}

/* Sound elements, one part, and a boundary that is one closed surface enclosing exactly the volume: so no
 * element overlaps another and no face is cut differently from its two sides. Returns the worst quality. */
static double meshgen_check_solid(const sb_mesh *mesh)
{
    sb_mesh_report report, skin;
    sb_boundary boundary;
    double worst = -1;
    if (!CHECK_OK(sb_mesh_validate(mesh, NULL)) || !CHECK_OK(sb_mesh_check(mesh, NULL, &report, NULL)))
        return worst;
    if (CHECK_OK(sb_mesh_boundary(mesh, 1, NULL, &boundary, NULL))) {
        CHECK_OK(sb_mesh_check(&boundary.surface, NULL, &skin, NULL));
        CHECK_INT(skin.bad_count + skin.open_edges + skin.nonmanifold_edges + skin.inconsistent_edges, 0);
        CHECK_INT(skin.nonmanifold_vertices + skin.duplicate_nodes, 0);
        CHECK_INT(skin.components, 1);
        /* Euler: a sphere has nodes - edges + faces = 2 (corner nodes) */
        if (!meshgen_is_quadratic(mesh->element_type))
            CHECK_INT(boundary.surface.node_count -
                          boundary.surface.element_count * sb_element_edge_count(boundary.surface.element_type) / 2 +
                          boundary.surface.element_count,
                      2);
        CHECK_NEAR(skin.volume / report.volume, 1, meshgen_eps(4096));
        sb_mesh_report_free(&skin);
        sb_boundary_free(&boundary);
    }
    CHECK_INT(report.bad_count + report.unreferenced_nodes + report.duplicate_nodes + report.nonmanifold_faces, 0);
    CHECK_INT(report.components, 1);
    CHECK(mesh->regions == NULL);
    worst = (double)report.worst_quality;
    sb_mesh_report_free(&report);
    return worst;
}

static void test_beam(void)
{
    for (int t = 0; t < MESHGEN_TYPES; t++) {
        sb_mesh mesh = meshgen_none();
        sb_vec3 low, high;
        int corners = 6 * 4 * 3;
        CHECK_OK(
            sb_mesh_beam(meshgen_types[t], 5, 3, 2, sb_v3(GREAL(0.1), GREAL(0.06), GREAL(0.04)), NULL, &mesh, NULL));
        CHECK_INT(mesh.element_type, meshgen_types[t]);
        CHECK_INT(mesh.element_count, meshgen_is_hex(t) ? 30 : 180);
        if (meshgen_types[t] == SB_HEX27)
            CHECK_INT(mesh.node_count, 11 * 7 * 5);
        else
            CHECK(meshgen_is_quadratic(mesh.element_type) ? mesh.node_count > corners : mesh.node_count == corners);
        CHECK(meshgen_check_solid(&mesh) > (meshgen_is_hex(t) ? 0.99 : 0.75));
        CHECK_NEAR(sb_mesh_volume(&mesh), 2.4e-4, 2.4e-4 * meshgen_eps(64));
        sb_mesh_bounds(&mesh, &low, &high);
        CHECK(low.x == 0 && low.y == 0 && low.z == 0);
        CHECK(high.x == GREAL(0.1) && high.y == GREAL(0.06) && high.z == GREAL(0.04));
        CHECK_NEAR(mesh.nodes[1].x, 0.02, meshgen_eps(1)); /* x fastest, then y, then z */
        CHECK_NEAR(mesh.nodes[6].y, 0.02, meshgen_eps(1));
        CHECK_NEAR(mesh.nodes[24].z, 0.02, meshgen_eps(1));
        sb_mesh_free(&mesh);
        CHECK_OK(sb_mesh_beam(meshgen_types[t], 1, 1, 1, sb_v3(1, 1, 1), NULL, &mesh, NULL));
        meshgen_check_solid(&mesh);
        sb_mesh_free(&mesh);
    }
}

/* All boundary nodes lie on the cylinder, and the volume is right to second order. */
static void test_cylinder(void)
{
    static const int across[] = {4, 5, 6, 7, 8, 16};
    for (int t = 0; t < MESHGEN_TYPES; t++) {
        for (int i = 0; i < 6; i++) {
            sb_mesh mesh = meshgen_none();
            sb_vec3 low, high;
            int axis = i % 3;
            CHECK_OK(sb_mesh_cylinder(meshgen_types[t], axis, GREAL(0.02), GREAL(0.04), across[i], across[i] - 1, NULL,
                                      &mesh, NULL));
            CHECK(meshgen_check_solid(&mesh) > (meshgen_is_hex(t) ? 0.6 : 0.4));
            sb_mesh_bounds(&mesh, &low, &high);
            CHECK_NEAR(axis == 0 ? high.x : (axis == 1 ? high.y : high.z), 0.04, meshgen_eps(1));
            CHECK_NEAR(axis == 0 ? low.x : (axis == 1 ? low.y : low.z), 0, 0);
            CHECK_NEAR(axis == 0 ? high.y : high.x, 0.02, across[i] < 8 ? 0.006 : 0.001);
            sb_mesh_free(&mesh);
        }
    }
}

static double meshgen_cylinder_volume(int across)
{
    sb_mesh mesh = meshgen_none();
    double volume;
    CHECK_OK(sb_mesh_cylinder(SB_HEX8, 2, 1, 1, across, 1, NULL, &mesh, NULL));
    volume = (double)sb_mesh_volume(&mesh);
    sb_mesh_free(&mesh);
    return volume;
}

static double meshgen_ball_volume(int cells)
{
    sb_mesh mesh = meshgen_none();
    double volume;
    CHECK_OK(sb_mesh_ellipsoid(SB_TET4, sb_v3(1, 2, GREAL(0.5)), cells, NULL, &mesh, NULL));
    volume = (double)sb_mesh_volume(&mesh);
    sb_mesh_free(&mesh);
    return volume;
}

static void test_volume_order(void)
{
    const double pi = 3.14159265358979323846;
    double coarse = pi - meshgen_cylinder_volume(10), fine = pi - meshgen_cylinder_volume(20);
    CHECK(coarse > 0 && fine > 0);
    CHECK_NEAR(log(coarse / fine) / log(2.0), 2, 0.1);
    coarse = 4 * pi / 3 - meshgen_ball_volume(10), fine = 4 * pi / 3 - meshgen_ball_volume(20);
    CHECK(coarse > 0 && fine > 0);
    CHECK_NEAR(log(coarse / fine) / log(2.0), 2, 0.1);
}

static void test_ellipsoid(void)
{
    for (int t = 0; t < MESHGEN_TYPES; t++) {
        for (int cells = 4; cells <= 13; cells++) {
            sb_mesh mesh = meshgen_none();
            sb_boundary boundary;
            CHECK_OK(sb_mesh_ellipsoid(meshgen_types[t], sb_v3(GREAL(0.03), GREAL(0.02), GREAL(0.04)), cells, NULL,
                                       &mesh, NULL));
            CHECK(meshgen_check_solid(&mesh) > (meshgen_is_hex(t) ? 0.4 : 0.25));
            CHECK_OK(sb_mesh_boundary(&mesh, 1, NULL, &boundary, NULL));
            for (int v = 0; !meshgen_is_quadratic(meshgen_types[t]) && v < boundary.surface.node_count; v++) {
                sb_vec3 x = boundary.surface.nodes[v];
                sb_vec3 u = sb_v3(x.x / GREAL(0.03), x.y / GREAL(0.02), x.z / GREAL(0.04));
                CHECK_NEAR(sb_v3_norm(u), 1, meshgen_eps(8));
            }
            sb_boundary_free(&boundary);
            sb_mesh_free(&mesh);
        }
    }
}

/* Sound at every size; the largest ones are covered by a few. */
static void test_organ(void)
{
    static const int cells[] = {4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 17, 22, 31};
    for (int t = 0; t < MESHGEN_TYPES; t++) {
        for (size_t i = 0; i < sizeof cells / sizeof cells[0]; i++) {
            sb_mesh mesh = meshgen_none();
            double volume;
            if (cells[i] > (meshgen_is_quadratic(meshgen_types[t]) ? 10 : (t == 0 ? 22 : 31)))
                continue;
            CHECK_OK(sb_mesh_organ(meshgen_types[t], cells[i], NULL, &mesh, NULL));
            CHECK(meshgen_check_solid(&mesh) > 0.2);
            volume = (double)sb_mesh_volume(&mesh);
            CHECK(volume < 1.55e-3 && volume > (cells[i] < 10 ? 1.1e-3 : 1.45e-3));
            sb_mesh_free(&mesh);
        }
    }
}

static void test_organ_largest(void)
{
    sb_mesh mesh = meshgen_none();
    CHECK_OK(sb_mesh_organ(SB_HEX8, 60, NULL, &mesh, NULL));
    CHECK(mesh.element_count > 100000);
    CHECK_OK(sb_mesh_validate(&mesh, NULL));
    CHECK_NEAR(sb_mesh_volume(&mesh), 1.52e-3, 1e-5);
    sb_mesh_free(&mesh);
}

/* Lowest point of the surface near a vertical line (m). */
static double meshgen_underside(const sb_mesh *mesh, double x, double y)
{
    double lowest = 1;
    for (int v = 0; v < mesh->node_count; v++) {
        sb_vec3 at = mesh->nodes[v];
        if (fabs((double)at.x - x) < 0.008 && fabs((double)at.y - y) < 0.008 && (double)at.z < lowest)
            lowest = (double)at.z;
    }
    return lowest;
}

/* Like a liver: two lobes of different size, and hollow below. */
static void test_organ_shape(void)
{
    sb_mesh mesh = meshgen_none();
    sb_vec3 low, high;
    double left = 0, right = 0, middle, chord;
    CHECK_OK(sb_mesh_organ(SB_TET4, 24, NULL, &mesh, NULL));
    sb_mesh_bounds(&mesh, &low, &high);
    CHECK_NEAR(high.x - low.x, 0.20, 0.01);
    CHECK_NEAR(high.y - low.y, 0.14, 0.02);
    CHECK_NEAR(high.z - low.z, 0.11, 0.02);
    for (int e = 0; e < mesh.element_count; e++) {
        double x = (double)mesh.nodes[mesh.elements[4 * e]].x, volume = (double)sb_mesh_element_volume(&mesh, e);
        *(x < 0 ? &right : &left) += volume;
    }
    CHECK(right > 1.3 * left);
    middle = meshgen_underside(&mesh, 0.01, 0);
    chord = 0.5 * (meshgen_underside(&mesh, -0.06, 0) + meshgen_underside(&mesh, 0.08, 0));
    CHECK(middle > chord + 0.005);
    sb_mesh_free(&mesh);
}

static void test_same_bits(void)
{
    for (int t = 0; t < MESHGEN_TYPES; t++) {
        sb_mesh a = meshgen_none(), b = meshgen_none();
        CHECK_OK(sb_mesh_organ(meshgen_types[t], 8, NULL, &a, NULL));
        CHECK_OK(sb_mesh_organ(meshgen_types[t], 8, NULL, &b, NULL));
        CHECK(memcmp(a.nodes, b.nodes, sizeof(sb_vec3) * (size_t)a.node_count) == 0);
        CHECK(memcmp(a.elements, b.elements,
                     sizeof(int) * (size_t)(a.element_count * sb_element_node_count(a.element_type))) == 0);
        sb_mesh_free(&a);
        sb_mesh_free(&b);
    }
}

/* ---- failures ---- */

static void test_arguments(void)
{
    const sb_vec3 unit = sb_v3(1, 1, 1);
    sb_mesh mesh = meshgen_none();
    sb_error error;
    volatile sb_real zero = 0;
    check_bad_numbers();
    sb_real nan = zero / zero, infinite = 1 / zero;
    CHECK_RESULT(sb_mesh_beam(SB_TRI3, 1, 1, 1, unit, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_beam(SB_NO_ELEMENT, 1, 1, 1, unit, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_beam(SB_TET4, 0, 1, 1, unit, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_beam(SB_TET4, 1, -1, 1, unit, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_beam(SB_TET4, 1, 1, INT_MIN, unit, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_beam(SB_TET4, 1, 1, 1, sb_v3(1, 0, 1), NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_beam(SB_TET4, 1, 1, 1, sb_v3(1, 1, nan), NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_beam(SB_TET4, 1, 1, 1, sb_v3(infinite, 1, 1), NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_beam(SB_TET4, 1, 1, 1, unit, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_cylinder(SB_TET4, 3, 1, 1, 4, 1, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_cylinder(SB_TET4, -1, 1, 1, 4, 1, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_cylinder(SB_TET4, 0, 1, 1, 3, 1, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_cylinder(SB_TET4, 0, 1, 1, INT_MIN, 1, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_cylinder(SB_TET4, 0, 1, 1, INT_MAX, 1, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_cylinder(SB_TET4, 0, 1, 1, 4, 0, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_cylinder(SB_TET4, 0, -1, 1, 4, 1, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_cylinder(SB_TET4, 0, 1, nan, 4, 1, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_ellipsoid(SB_QUAD4, unit, 4, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_ellipsoid(SB_TET4, unit, 3, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_ellipsoid(SB_TET4, unit, INT_MAX, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_ellipsoid(SB_TET4, sb_v3(1, nan, 1), 4, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_organ(SB_TET4, 3, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_organ(SB_TET4, 61, NULL, &mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_organ(SB_TET4, 8, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK(mesh.nodes == NULL && mesh.elements == NULL && mesh.node_count == 0);
}

/* ---- an allocator that counts, refuses large blocks, and fails on request ---- */

typedef struct meshgen_memory {
    int live, calls, fail_at;
    size_t limit;
} meshgen_memory;

static void *meshgen_alloc(void *user, size_t bytes)
{
    meshgen_memory *memory = (meshgen_memory *)user;
    void *pointer = memory->calls++ == memory->fail_at || bytes > memory->limit ? NULL : malloc(bytes);
    memory->live += pointer != NULL;
    return pointer;
}
static void meshgen_release(void *user, void *pointer)
{
    ((meshgen_memory *)user)->live -= pointer != NULL;
    free(pointer);
}

/* Counts that fit an int one by one but not together; the allocator would notice a wrapped size. */
static void test_too_many(void)
{
    static const int counts[][3] = {{INT_MAX, INT_MAX, INT_MAX}, {1, 1, INT_MAX},    {65536, 65536, 1},
                                    {46340, 46340, 1},           {2000, 2000, 2000}, {1290, 1290, 1290}};
    meshgen_memory memory = {0, 0, -1, 0};
    sb_allocator allocator;
    sb_mesh mesh = meshgen_none();
    allocator.alloc = meshgen_alloc, allocator.release = meshgen_release, allocator.user = &memory;
    for (size_t i = 0; i < sizeof counts / sizeof counts[0]; i++)
        CHECK_RESULT(
            sb_mesh_beam(SB_TET4, counts[i][0], counts[i][1], counts[i][2], sb_v3(1, 1, 1), &allocator, &mesh, NULL),
            SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_cylinder(SB_HEX8, 0, 1, 1, 20000, INT_MAX, &allocator, &mesh, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_ellipsoid(SB_TET4, sb_v3(1, 1, 1), 1001, &allocator, &mesh, NULL), SB_ERROR_ARGUMENT);
    CHECK_INT(memory.calls, 0);
    CHECK_RESULT(sb_mesh_beam(SB_HEX8, 1280, 1280, 1280, sb_v3(1, 1, 1), &allocator, &mesh, NULL), SB_ERROR_MEMORY);
    CHECK((memory.calls > 0 || SIZE_MAX <= UINT32_MAX) && memory.live == 0 && mesh.nodes == NULL);
}

static sb_result meshgen_call(int which, sb_element_type type, const sb_allocator *allocator, sb_mesh *mesh)
{
    switch (which) {
    case 0: return sb_mesh_beam(type, 2, 2, 2, sb_v3(1, 1, 1), allocator, mesh, NULL);
    case 1: return sb_mesh_cylinder(type, 0, 1, 1, 4, 2, allocator, mesh, NULL);
    case 2: return sb_mesh_ellipsoid(type, sb_v3(1, 1, 1), 4, allocator, mesh, NULL);
    default: return sb_mesh_organ(type, 4, allocator, mesh, NULL);
    }
}

static void test_allocation_failures(void)
{
    for (int n = 0; n < 12; n++) {
        meshgen_memory memory = {0, 0, -1, (size_t)-1};
        sb_allocator allocator;
        sb_result result = SB_ERROR_MEMORY;
        int fail;
        allocator.alloc = meshgen_alloc, allocator.release = meshgen_release, allocator.user = &memory;
        for (fail = 0; result == SB_ERROR_MEMORY && fail < 50; fail++) {
            sb_mesh mesh = meshgen_none();
            memory.calls = 0, memory.fail_at = fail;
            result = meshgen_call(n / 3, meshgen_types[n % 3], &allocator, &mesh);
            if (result != SB_OK)
                CHECK(mesh.nodes == NULL && mesh.node_count == 0);
            CHECK_INT(memory.live, result == SB_OK ? 2 : 0);
            sb_mesh_free(&mesh);
            CHECK_INT(memory.live, 0);
        }
        CHECK_OK(result);
        CHECK(fail > 2);
    }
}

CHECK_SUITE(meshgen, {"beam", test_beam}, {"cylinder", test_cylinder}, {"volume converges", test_volume_order},
            {"ellipsoid", test_ellipsoid}, {"organ", test_organ}, {"organ at its finest", test_organ_largest},
            {"organ looks like a liver", test_organ_shape}, {"same bits", test_same_bits},
            {"arguments", test_arguments}, {"too many cells", test_too_many},
            {"every allocation failing", test_allocation_failures});
