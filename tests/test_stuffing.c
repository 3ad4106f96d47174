/* stuffing: meshes of functions and surfaces: angles, distance, manifold boundaries, regions, failures. */
#include "softbody.h"

#include "scene.h"

/* ---- shapes ---- */

enum { BALL, TORUS, BOX, BLOBS, PLANE };

typedef struct shape {
    int kind;
    double p[32];
} shape;

static double ball(const double *p, sb_vec3 x)
{
    double d[3] = {(double)x.x - p[0], (double)x.y - p[1], (double)x.z - p[2]};
    return sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]) - p[3];
}

static double box(const double *p, sb_vec3 x)
{
    double at[3] = {(double)x.x, (double)x.y, (double)x.z}, outside = 0, inside = -1e30;
    for (int axis = 0; axis < 3; axis++) {
        double q = fabs(at[axis] - p[axis]) - p[3 + axis];
        outside += q > 0 ? q * q : 0;
        inside = q > inside ? q : inside;
    }
    return outside > 0 ? sqrt(outside) : inside;
}

static sb_real shape_distance(void *user, sb_vec3 x)
{
    const shape *s = (const shape *)user;
    double r, sum = 0;
    switch (s->kind) {
    case BALL: return REAL(ball(s->p, x));
    case TORUS:
        r = sqrt((double)(x.x * x.x + x.y * x.y)) - s->p[0];
        return REAL(sqrt(r * r + (double)(x.z * x.z)) - s->p[1]);
    case BOX: return REAL(box(s->p, x));
    case PLANE: return REAL((double)x.x * s->p[0] + (double)x.y * s->p[1] + (double)x.z * s->p[2] - s->p[3]);
    default:
        for (int k = 0; k < 8; k++) {
            double d = (ball(s->p + 4 * k, x) + s->p[4 * k + 3]) / s->p[4 * k + 3];
            sum += 1 / ((1 + d * d) * (1 + d * d) * (1 + d * d));
        }
        return REAL(0.4 - sum);
    }
}

static shape make_shape(int kind, double a, double b, double c, double d, double e, double f)
{
    shape s;
    memset(&s, 0, sizeof s);
    s.kind = kind;
    s.p[0] = a, s.p[1] = b, s.p[2] = c, s.p[3] = d, s.p[4] = e, s.p[5] = f;
    return s;
}

static shape random_shape(int kind, unsigned long long *seed)
{
    shape s;
    memset(&s, 0, sizeof s);
    s.kind = kind;
    for (int k = 0; k < 8; k++) {
        for (int i = 0; i < 3; i++)
            s.p[4 * k + i] = check_random_in(seed, -0.6, 0.6);
        s.p[4 * k + 3] = check_random_in(seed, 0.2, 0.45);
    }
    if (kind == BOX)
        s.p[4] = s.p[0] + 0.5, s.p[5] = 0.3;
    return s;
}

#define MAX_SHAPES 4
typedef struct scene {
    shape shapes[MAX_SHAPES];
    sb_shape described[MAX_SHAPES];
    sb_stuff_def def;
} scene;

/* Regions are 10, 11, ... The box has room for shapes of radius 1.2; `shift` moves the lattice. */
static void set_scene(scene *s, const shape *shapes, int count, double cell, double shift)
{
    memset(s, 0, sizeof *s);
    for (int i = 0; i < count; i++) {
        s->shapes[i] = shapes[i];
        s->described[i].distance = shape_distance;
        s->described[i].user = s->shapes + i;
        s->described[i].max_slope = shapes[i].kind == BLOBS ? REAL(0) : REAL(1);
        s->described[i].region = 10 + i;
    }
    s->def = sb_default_stuff_def();
    s->def.shapes = s->described;
    s->def.shape_count = count;
    s->def.cell = REAL(cell);
    s->def.low = sb_v3(REAL(-1.2 - shift * cell), REAL(-1.2 - 0.7 * shift * cell), REAL(-1.2 - 0.4 * shift * cell));
    s->def.high = sb_v3(REAL(1.2), REAL(1.2), REAL(1.2));
}

/* ---- what every mesh must satisfy ---- */

typedef struct verdict {
    sb_stuff_report report;
    double volumes[MAX_SHAPES];
    int components;
} verdict;

/* Elements of one region. */
static sb_mesh region_of(const sb_mesh *mesh, int region)
{
    sb_mesh part;
    if (sb_mesh_copy(mesh, NULL, &part, NULL) != SB_OK) {
        memset(&part, 0, sizeof part);
        return part;
    }
    part.element_count = 0;
    for (int e = 0; e < mesh->element_count; e++)
        if (mesh->regions[e] == region)
            memcpy(part.elements + 4 * (size_t)part.element_count++, mesh->elements + 4 * (size_t)e, 4 * sizeof(int));
    return part;
}

static void check_closed(const sb_mesh *mesh, int manifold)
{
    sb_boundary boundary;
    sb_mesh_report report;
    if (mesh->element_count == 0 || !CHECK_OK(sb_mesh_boundary(mesh, 1, NULL, &boundary, NULL)))
        return;
    if (CHECK_OK(sb_mesh_check(&boundary.surface, NULL, &report, NULL))) {
        CHECK_INT(report.open_edges, 0);
        if (manifold) {
            CHECK_INT(report.nonmanifold_edges, 0);
            CHECK_INT(report.nonmanifold_vertices, 0);
            CHECK_INT(report.inconsistent_edges, 0);
        }
        sb_mesh_report_free(&report);
    }
    sb_boundary_free(&boundary);
}

static void check_mesh(const sb_mesh *mesh, int shapes, const sb_stuff_report *stuffed, verdict *v)
{
    sb_mesh_report report;
    sb_real least, most;
    memset(v, 0, sizeof *v);
    v->report = *stuffed;
    CHECK_OK(sb_mesh_validate(mesh, NULL));
    if (CHECK_OK(sb_mesh_check(mesh, NULL, &report, NULL))) {
        CHECK_INT(report.nonmanifold_faces, 0);
        CHECK_INT(report.unreferenced_nodes, 0);
        CHECK_INT(report.duplicate_nodes, 0);
        v->components = report.components;
        sb_mesh_report_free(&report);
    }
    check_closed(mesh, 1);
    for (int i = 0; i < shapes; i++) {
        sb_mesh part = region_of(mesh, 10 + i);
        v->volumes[i] = (double)sb_mesh_volume(&part);
        if (shapes > 1)
            check_closed(&part, 0);
        sb_mesh_free(&part);
    }
    sb_mesh_dihedral_range(mesh, &least, &most);
    CHECK(least >= REAL(10.69) && most <= REAL(164.81));
    CHECK_NEAR(stuffed->min_dihedral, least, 0);
    CHECK_NEAR(stuffed->max_dihedral, most, 0);
    CHECK_INT(stuffed->node_count, mesh->node_count);
    CHECK_INT(stuffed->element_count, mesh->element_count);
    CHECK_NEAR(stuffed->volume, sb_mesh_volume(mesh), 0);
}

/* Stuffs, checks and frees. */
static verdict stuff_and_check(const sb_stuff_def *def)
{
    sb_mesh mesh;
    sb_stuff_report report;
    sb_error error;
    verdict v;
    memset(&v, 0, sizeof v);
    memset(&mesh, 0, sizeof mesh);
    if (sb_mesh_stuff(def, &mesh, &report, &error) != SB_OK) {
        printf("%s: %s\n", sb_result_string(error.result), error.message);
        CHECK(error.result == SB_OK);
        return v;
    }
    check_mesh(&mesh, def->shape_count, &report, &v);
    sb_mesh_free(&mesh);
    return v;
}

static void test_dihedral_range(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 1, 1, 1, sb_v3(1, 1, 1), 0);
    sb_vec3 regular[4] = {{1, 1, 1}, {1, -1, -1}, {-1, 1, -1}, {-1, -1, 1}};
    int corners[4] = {0, 1, 2, 3};
    sb_real least, most;
    sb_mesh one;
    sb_mesh_dihedral_range(&mesh, &least, &most); /* Kuhn's tets of a cube: 45, 60 and 90 degrees */
    CHECK_NEAR(least, 45, scene_tolerance(1e-12, 1000));
    CHECK_NEAR(most, 90, scene_tolerance(1e-12, 1000));
    sb_mesh_free(&mesh);
    memset(&one, 0, sizeof one);
    one.node_count = 4;
    one.nodes = regular;
    one.element_type = SB_TET4;
    one.element_count = 1;
    one.elements = corners;
    sb_mesh_dihedral_range(&one, &least, &most);
    CHECK_NEAR(least, acos(1.0 / 3) * 57.29577951308232, scene_tolerance(1e-12, 1000));
    CHECK_NEAR(most, least, scene_tolerance(1e-12, 1000));
    one.element_type = SB_HEX8;
    sb_mesh_dihedral_range(&one, &least, &most);
    CHECK(least == 0 && most == 0);
    sb_mesh_dihedral_range(NULL, NULL, NULL);
}

/* ---- one shape ---- */

static void test_ball(void)
{
    shape s = make_shape(BALL, 0.02, -0.03, 0.01, 1, 0, 0);
    double exact = 4.0 / 3 * 3.14159265358979, last = 1;
    for (int levels = 0; levels < 4; levels++) {
        scene at;
        verdict v;
        set_scene(&at, &s, 1, 0.1, 0.37);
        at.def.levels = levels;
        v = stuff_and_check(&at.def);
        CHECK_NEAR(v.report.volume, exact, 0.004 * exact);
        CHECK(v.report.distance < REAL(0.15 * 0.1));
        CHECK_INT(v.components, 1);
    }
    for (int k = 0; k < 3; k++) { /* the volume is short by O(cell^2) */
        scene at;
        double error, cell = 0.5 / (1 << k);
        set_scene(&at, &s, 1, cell, 0.2);
        error = 1 - (double)stuff_and_check(&at.def).report.volume / exact;
        CHECK(error > 0 && error < 0.45 * last);
        last = error;
    }
}

static void test_graded_count(void)
{
    shape s = make_shape(BALL, 0, 0, 0, 1, 0, 0);
    scene at;
    int uniform, graded;
    set_scene(&at, &s, 1, 0.075, 0.1);
    uniform = stuff_and_check(&at.def).report.element_count;
    at.def.levels = 4;
    graded = stuff_and_check(&at.def).report.element_count;
    CHECK(graded < 2 * uniform / 3);
}

static void test_ridges(void)
{
    for (int k = 0; k < 8; k++) {
        shape s = make_shape(BOX, 0.01, 0.02, 0.03, 0.9, 0.7 - 0.01 * k, 0.5 + 0.007 * k);
        double exact = 8 * s.p[3] * s.p[4] * s.p[5];
        scene at;
        verdict v;
        set_scene(&at, &s, 1, 0.13, 0.083 * k);
        at.def.levels = k % 3;
        v = stuff_and_check(&at.def);
        CHECK(v.report.distance < REAL(0.13 / 3));
        CHECK_NEAR(v.report.volume, exact, 0.02 * exact);
    }
}

/* A plane through lattice points, edges and faces: f is 0 at whole layers. */
static void test_aligned(void)
{
    for (int k = 0; k < 4; k++) {
        shape s = make_shape(BOX, 0, 0, 0, 0.8, 0.6, 0.4);
        scene at;
        verdict v;
        set_scene(&at, &s, 1, 0.1, 0);
        at.def.low = sb_v3(REAL(-1), REAL(-1), REAL(-1));
        at.def.high = sb_v3(REAL(1 + 0.05 * k), 1, 1);
        v = stuff_and_check(&at.def);
        CHECK(v.report.distance < REAL(0.1 / 3));
        CHECK_NEAR(v.report.volume, 8 * 0.8 * 0.6 * 0.4, 0.03);
    }
}

static void test_torus(void)
{
    shape s = make_shape(TORUS, 0.7, 0.3, 0, 0, 0, 0);
    for (int k = 0; k < 6; k++) {
        scene at;
        verdict v;
        set_scene(&at, &s, 1, 0.09 + 0.01 * k, 0.17 * k);
        at.def.levels = k % 3;
        v = stuff_and_check(&at.def);
        CHECK_INT(v.components, 1);
        CHECK(v.report.distance < REAL(0.15) * at.def.cell);
        CHECK_NEAR(v.report.volume, 2 * 9.8696044 * 0.7 * 0.09, 0.06);
    }
}

/* Shapes of any kind, also far too fine for the cells: still sound, manifold, and with the same angles. */
static void test_random_shapes(void)
{
    unsigned long long seed = 11;
    for (int k = 0; k < (check_quick() ? 8 : 28); k++) {
        shape s = random_shape(BLOBS, &seed);
        scene at;
        set_scene(&at, &s, 1, check_random_in(&seed, 0.1, 0.3), check_random(&seed));
        at.def.levels = k % 4;
        stuff_and_check(&at.def);
    }
}

/* A plate of any thickness: from a cell and a half on it comes out whole and close. */
static void test_plates(void)
{
    for (int k = 0; k < 9; k++) {
        double thickness = 0.1 * (0.2 + 0.3 * k);
        shape s = make_shape(BOX, 0.01, 0.02, 0.03, 0.8, 0.8, 0.5 * thickness);
        scene at;
        sb_mesh mesh;
        sb_stuff_report report;
        sb_result result;
        verdict v;
        memset(&mesh, 0, sizeof mesh);
        set_scene(&at, &s, 1, 0.1, 0.13 * k);
        result = sb_mesh_stuff(&at.def, &mesh, &report, NULL);
        if (thickness < 0.1 && result == SB_ERROR_MESH) { /* nothing of it is left, and it says so */
            CHECK(mesh.nodes == NULL);
            continue;
        }
        if (!CHECK_OK(result))
            continue;
        check_mesh(&mesh, 1, &report, &v);
        if (thickness > 0.15) {
            CHECK_INT(v.components, 1);
            CHECK(report.distance < REAL(0.04));
            CHECK_NEAR(report.volume, 2.56 * thickness, 0.1 * 2.56 * thickness);
        }
        sb_mesh_free(&mesh);
    }
}

static void test_clipped_by_box(void)
{
    shape s = make_shape(PLANE, 0.6, 0, 0.8, 0.1, 0, 0);
    scene at;
    verdict v;
    set_scene(&at, &s, 1, 0.11, 0);
    v = stuff_and_check(&at.def);
    CHECK_NEAR(v.report.volume, 0.5 * 2.4 * 2.4 * 2.4 + 0.1 / 0.8 * 2.4 * 2.4, 0.05);
    CHECK(v.report.distance < REAL(0.11 / 3));
}

/* The same numbers at any size, up to rounding: counts and angles. */
static void test_scale(void)
{
    shape s = make_shape(BALL, 0.1, 0.2, 0.3, 0.7, 0, 0);
    sb_stuff_report first;
    memset(&first, 0, sizeof first);
    for (int k = 0; k < 3; k++) {
        double scale = k == 0 ? 1 : k == 1 ? 1.0 / 1024 : 1024;
        shape scaled = s;
        scene at;
        verdict v;
        for (int i = 0; i < 4; i++)
            scaled.p[i] *= scale;
        set_scene(&at, &scaled, 1, 0.1 * scale, 0);
        at.def.low = sb_v3_scale(REAL(scale), sb_v3(-1, -1, -1));
        at.def.high = sb_v3_scale(REAL(scale), sb_v3(1, 1, 1));
        v = stuff_and_check(&at.def);
        if (k == 0)
            first = v.report;
        CHECK_INT(v.report.element_count, first.element_count);
        CHECK_NEAR(v.report.min_dihedral, first.min_dihedral, scene_tolerance(1e-9, 1e5));
        CHECK_NEAR((double)v.report.volume / (scale * scale * scale), first.volume, scene_tolerance(1e-9, 100));
    }
}

/* ---- several shapes ---- */

static void test_nested(void)
{
    shape s[3];
    double outer = 8 * 0.9 * 0.9 * 0.9, middle = 4.0 / 3 * 3.14159265 * 0.6 * 0.6 * 0.6, inner = middle / 8;
    s[0] = make_shape(BOX, 0, 0, 0, 0.9, 0.9, 0.9);
    s[1] = make_shape(BALL, 0.05, 0, 0, 0.6, 0, 0);
    s[2] = make_shape(BALL, 0.1, 0.03, 0, 0.3, 0, 0);
    for (int levels = 0; levels < 3; levels++) {
        scene at;
        verdict v;
        set_scene(&at, s, 3, 0.11, 0.21);
        at.def.levels = levels;
        v = stuff_and_check(&at.def);
        CHECK_NEAR(v.volumes[0] + v.volumes[1] + v.volumes[2], outer, 0.01 * outer);
        CHECK_NEAR(v.volumes[1], middle - inner, 0.03 * middle);
        CHECK_NEAR(v.volumes[2], inner, 0.04 * inner);
        CHECK(v.report.distance < REAL(0.11 / 3));
    }
}

/* Side by side, apart and touching (a face and a line of three regions), and sticking out of the first. */
static void test_side_by_side(void)
{
    for (int k = 0; k < 6; k++) {
        shape s[3];
        scene at;
        verdict v;
        double half = 0.25 + 0.05 * k; /* 0.5 apart: they touch from k = 5 on; the last overlap */
        s[0] = make_shape(BALL, 0, 0, 0, 1, 0, 0);
        s[1] = make_shape(BOX, -0.5, 0, 0, half, 0.4, 0.4);
        s[2] = make_shape(BOX, 0.5, 0, 0, half, 0.4, 0.4);
        set_scene(&at, s, 3, 0.11, 0.3 * k);
        v = stuff_and_check(&at.def);
        CHECK_NEAR(v.volumes[0] + v.volumes[1] + v.volumes[2], 4.18879, 0.03);
        if (k < 3) {
            CHECK_NEAR(v.volumes[1], 8 * half * 0.16, 0.02);
            CHECK_NEAR(v.volumes[2], 8 * half * 0.16, 0.02);
        }
        CHECK(v.volumes[1] > 0.25 && v.volumes[2] > 0.25);
    }
}

static void test_random_regions(void)
{
    unsigned long long seed = 5;
    for (int k = 0; k < 16; k++) {
        shape s[4];
        scene at;
        s[0] = random_shape(BLOBS, &seed);
        s[1] = random_shape(BALL, &seed);
        s[2] = random_shape(BOX, &seed);
        s[3] = random_shape(BALL, &seed);
        set_scene(&at, s, 4, check_random_in(&seed, 0.1, 0.3), check_random(&seed));
        at.def.levels = k % 4;
        at.def.least_share = 0; /* some regions are smaller than a cell */
        stuff_and_check(&at.def);
    }
}

/* ---- surfaces ---- */

static const char *const surface_names[] = {"surfaces/liver_a.obj",
                                            "surfaces/liver_b.obj",
                                            "surfaces/liver_a_uniform_coarse.obj",
                                            "surfaces/liver_a_uniform_fine.obj",
                                            "surfaces/bunny.obj",
                                            "surfaces/torus.obj",
                                            "phantom/skin.obj",
                                            "phantom/prostate.obj"};
enum { SURFACE_COUNT = (int)(sizeof surface_names / sizeof surface_names[0]) };

static int load_surface(const char *name, sb_mesh *mesh, sb_surface **surface)
{
    char path[512], shared[300];
    snprintf(shared, sizeof shared, "data/%s", name);
    if (!check_shared_path(path, sizeof path, shared)) {
        CHECK_SKIP(shared);
        return 0;
    }
    return CHECK_OK(sb_mesh_load(mesh, path, NULL, NULL)) && CHECK_OK(sb_surface_create(mesh, NULL, surface, NULL));
}

static sb_real longest_side(const sb_surface *surface)
{
    sb_vec3 low, high, size;
    sb_surface_bounds(surface, &low, &high);
    size = sb_v3_sub(high, low);
    return sb_max(size.x, sb_max(size.y, size.z));
}

/* Every surface of the shared data: angles, and the boundary within a third of a cell, measured here once more. */
static void test_surfaces(void)
{
    static const int counts[3] = {12, 16, 23}; /* at 12 and 23 a bunny's ears end between lattice points */
    for (int k = 0; k < SURFACE_COUNT; k++) {
        sb_mesh input;
        sb_surface *surface = NULL;
        sb_shape described;
        memset(&input, 0, sizeof input);
        memset(&described, 0, sizeof described);
        if (!load_surface(surface_names[k], &input, &surface))
            return;
        described.surface = surface;
        described.region = 10;
        for (int c = 0; c < 3; c++) {
            sb_stuff_def def = sb_default_stuff_def();
            double volume = (double)sb_mesh_volume(&input);
            verdict v;
            def.shapes = &described;
            def.shape_count = 1;
            def.cell = longest_side(surface) / REAL(counts[c]);
            def.levels = c % 3;
            v = stuff_and_check(&def);
            CHECK(v.report.distance < def.cell / 3);
            CHECK_NEAR(v.report.volume, volume, (c < 2 ? 0.08 : 0.02) * volume);
            CHECK_INT(v.components, 1);
        }
        sb_surface_destroy(surface);
        sb_mesh_free(&input);
    }
}

static void test_phantom(void)
{
    sb_mesh input[2];
    sb_surface *surface[2] = {NULL, NULL};
    sb_shape described[2];
    sb_stuff_def def = sb_default_stuff_def();
    memset(input, 0, sizeof input);
    memset(described, 0, sizeof described);
    if (!load_surface("phantom/skin.obj", input, surface) ||
        !load_surface("phantom/prostate.obj", input + 1, surface + 1))
        return;
    for (int i = 0; i < 2; i++) {
        described[i].surface = surface[i];
        described[i].region = 10 + i;
    }
    def.shapes = described;
    def.shape_count = 2;
    for (int k = 0; k < 2; k++) {
        double skin = (double)sb_mesh_volume(input), prostate = (double)sb_mesh_volume(input + 1);
        verdict v;
        def.cell = longest_side(surface[0]) / 24;
        def.levels = 2 * k;
        v = stuff_and_check(&def);
        CHECK_NEAR(v.volumes[0] + v.volumes[1], skin, 0.005 * skin);
        CHECK_NEAR(v.volumes[1], prostate, 0.03 * prostate);
        CHECK(v.report.distance < def.cell / 4);
    }
    for (int i = 0; i < 2; i++) {
        sb_surface_destroy(surface[i]);
        sb_mesh_free(input + i);
    }
}

/* ---- use ---- */

static void test_body(void)
{
    shape s[2];
    scene at;
    sb_mesh mesh;
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    memset(&mesh, 0, sizeof mesh);
    s[0] = make_shape(BALL, 0, 0, 0, 1, 0, 0);
    s[1] = make_shape(BALL, 0.1, 0, 0, 0.4, 0, 0);
    set_scene(&at, s, 2, 0.25, 0);
    at.def.type = SB_TET10;
    if (!CHECK_OK(sb_mesh_stuff(&at.def, &mesh, NULL, NULL)))
        return;
    CHECK_INT(mesh.element_type, SB_TET10);
    CHECK_OK(sb_mesh_validate(&mesh, NULL));
    def.mesh = &mesh;
    def.material = sb_material_corotated(REAL(5e3), REAL(0.4), REAL(1000));
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    body = scene_body(&def);
    if (body)
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static unsigned long long mesh_hash(const sb_mesh *mesh)
{
    return scene_hash(mesh->nodes, (size_t)mesh->node_count * sizeof(sb_vec3)) ^
           scene_hash(mesh->elements, (size_t)mesh->element_count * 4 * sizeof(int)) * 3 ^
           scene_hash(mesh->regions, (size_t)mesh->element_count * sizeof(int)) * 5;
}

static void test_threads(void)
{
    unsigned long long seed = 3, hash = 0;
    shape s[2];
    scene at;
    s[0] = random_shape(BLOBS, &seed);
    s[1] = random_shape(BALL, &seed);
    for (int workers = 0; workers < 4; workers++) {
        sb_mesh mesh;
        memset(&mesh, 0, sizeof mesh);
        set_scene(&at, s, 2, 0.1, 0.4);
        if (workers > 0)
            at.def.jobs = scene_jobs(&workers);
        if (!CHECK_OK(sb_mesh_stuff(&at.def, &mesh, NULL, NULL)))
            return;
        if (workers == 0)
            hash = mesh_hash(&mesh);
        CHECK(mesh_hash(&mesh) == hash);
        sb_mesh_free(&mesh);
    }
}

/* ---- failures ---- */

typedef struct progress_log {
    int calls, cancel_at;
    double last;
    int ordered;
} progress_log;

static int log_progress(void *user, double fraction)
{
    progress_log *log = (progress_log *)user;
    log->ordered = log->ordered && fraction >= log->last && fraction <= 1;
    log->last = fraction;
    return ++log->calls == log->cancel_at;
}

static void test_progress(void)
{
    shape s = make_shape(BALL, 0, 0, 0, 1, 0, 0);
    progress_log log = {0, 0, 0, 1};
    scene at;
    scene_memory memory = {0, 0, 0, 0};
    sb_mesh mesh;
    sb_error error;
    int calls;
    memset(&mesh, 0, sizeof mesh);
    set_scene(&at, &s, 1, 0.2, 0);
    at.def.allocator = scene_allocator(&memory);
    at.def.progress = log_progress;
    at.def.progress_user = &log;
    CHECK_OK(sb_mesh_stuff(&at.def, &mesh, NULL, NULL));
    CHECK(log.ordered && log.last == 1.0);
    sb_mesh_free(&mesh);
    calls = log.calls;
    for (int k = 1; k <= calls; k++) {
        memset(&log, 0, sizeof log);
        log.cancel_at = k;
        CHECK_RESULT(sb_mesh_stuff(&at.def, &mesh, NULL, &error), SB_ERROR_CANCELLED);
        CHECK_INT(memory.live, 0);
        CHECK(mesh.nodes == NULL);
    }
}

static void test_allocation_failures(void)
{
    shape s[2];
    scene at;
    int failed = 0;
    s[0] = make_shape(BOX, 0, 0, 0, 0.8, 0.7, 0.6);
    s[1] = make_shape(BALL, 0, 0, 0, 0.4, 0, 0);
    set_scene(&at, s, 2, 0.3, 0.3);
    at.def.levels = 2;
    at.def.type = SB_TET10;
    for (int k = 1;; k++) {
        scene_memory memory = {0, 0, 0, 0};
        sb_mesh mesh;
        sb_stuff_report report;
        sb_result result;
        memory.fail_at = k;
        memset(&mesh, 0, sizeof mesh);
        memset(&report, 7, sizeof report);
        at.def.allocator = scene_allocator(&memory);
        result = sb_mesh_stuff(&at.def, &mesh, &report, NULL);
        if (result == SB_OK) {
            sb_mesh_free(&mesh);
            CHECK_INT(memory.live, 0);
            break;
        }
        failed++;
        CHECK_RESULT(result, SB_ERROR_MEMORY);
        CHECK_INT(memory.live, 0);
        CHECK(mesh.nodes == NULL && report.node_count == 0x07070707);
    }
    CHECK(failed > 20);
}

static sb_real not_finite(void *user, sb_vec3 p)
{
    (void)user;
    return p.x > REAL(0.3) && p.y < 0 ? REAL(NAN) : sb_v3_norm(p) - REAL(0.9);
}

static sb_real nothing(void *user, sb_vec3 p)
{
    (void)user;
    (void)p;
    return 1;
}

static sb_real sign_only(void *user, sb_vec3 p)
{
    (void)user;
    return sb_v3_norm(p) < REAL(0.9) ? REAL(-1) : REAL(1);
}

static void refuse(const sb_stuff_def *def, sb_result expected, const char *word)
{
    sb_mesh mesh;
    sb_error error;
    memset(&mesh, 0, sizeof mesh);
    memset(&error, 0, sizeof error);
    CHECK_RESULT(sb_mesh_stuff(def, &mesh, NULL, &error), expected);
    if (!CHECK(strstr(error.message, word) != NULL))
        printf("    message: %s\n", error.message);
    CHECK(mesh.nodes == NULL && mesh.element_count == 0);
}

static void test_arguments(void)
{
    shape s = make_shape(BALL, 0, 0, 0, 0.9, 0, 0);
    scene at;
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
#define REFUSE(change, result, word)                                                                                   \
    set_scene(&at, &s, 1, 0.1, 0);                                                                                     \
    change;                                                                                                            \
    refuse(&at.def, result, word)
    refuse(NULL, SB_ERROR_ARGUMENT, "def");
    set_scene(&at, &s, 1, 0.1, 0);
    CHECK_RESULT(sb_mesh_stuff(&at.def, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    REFUSE(at.def.cookie = 0, SB_ERROR_ARGUMENT, "sb_default_stuff_def");
    REFUSE(at.def.shapes = NULL, SB_ERROR_ARGUMENT, "shapes");
    REFUSE(at.def.shape_count = 0, SB_ERROR_ARGUMENT, "shapes");
    REFUSE(at.def.shape_count = SB_STUFF_MAX_SHAPES + 1, SB_ERROR_ARGUMENT, "shapes");
    REFUSE(at.described[0].distance = NULL, SB_ERROR_ARGUMENT, "shape 0");
    REFUSE(at.described[0].max_slope = -1, SB_ERROR_ARGUMENT, "max_slope");
    REFUSE(at.described[0].max_slope = REAL(NAN), SB_ERROR_NOT_FINITE, "max_slope");
    REFUSE(at.def.cell = 0, SB_ERROR_ARGUMENT, "cell");
    REFUSE(at.def.cell = -1, SB_ERROR_ARGUMENT, "cell");
    REFUSE(at.def.cell = REAL(NAN), SB_ERROR_NOT_FINITE, "cell");
    REFUSE(at.def.levels = -1, SB_ERROR_ARGUMENT, "levels");
    REFUSE(at.def.levels = 9, SB_ERROR_ARGUMENT, "levels");
    REFUSE(at.def.type = SB_HEX8, SB_ERROR_ARGUMENT, "SB_TET4");
    REFUSE(at.def.max_elements = 0, SB_ERROR_ARGUMENT, "max_elements");
    REFUSE(at.def.low.x = at.def.high.x, SB_ERROR_ARGUMENT, "box");
    REFUSE(at.def.low.y = REAL(NAN), SB_ERROR_NOT_FINITE, "box");
    REFUSE(at.def.cell = REAL(1e-6), SB_ERROR_ARGUMENT, "cells");
    REFUSE(at.def.cell = REAL(1e-30), SB_ERROR_ARGUMENT, "cells");
    REFUSE(at.def.max_elements = 9000, SB_ERROR_ARGUMENT, "max_elements");
    REFUSE(at.described[0].distance = not_finite, SB_ERROR_NOT_FINITE, "shape 0");
    REFUSE(at.described[0].distance = nothing, SB_ERROR_MESH, "inside");
    REFUSE(at.described[0].max_slope = 0; at.described[0].distance = nothing, SB_ERROR_MESH, "inside");
#undef REFUSE
}

/* Splits of the boundary, as at these ridges, add elements after those of the lattice were counted: that too is an
 * argument, not memory. */
static void test_element_limit(void)
{
    for (int k = 0; k < (check_quick() ? 2 : 8); k++) {
        shape s = make_shape(BOX, 0.01, 0.02, 0.03, 0.9, 0.7 - 0.01 * k, 0.5 + 0.007 * k);
        scene at;
        sb_mesh mesh;
        sb_result result;
        int count;
        set_scene(&at, &s, 1, 0.13, 0.083 * k);
        count = stuff_and_check(&at.def).report.element_count;
        at.def.max_elements = count;
        CHECK_INT(stuff_and_check(&at.def).report.element_count, count);
        at.def.max_elements = count / 2;
        refuse(&at.def, SB_ERROR_ARGUMENT, "max_elements");
        at.def.max_elements = count - 1; /* another place of the lattice may need fewer */
        memset(&mesh, 0, sizeof mesh);
        result = sb_mesh_stuff(&at.def, &mesh, NULL, NULL);
        CHECK(result == SB_OK ? mesh.element_count < count : result == SB_ERROR_ARGUMENT);
        sb_mesh_free(&mesh);
    }
}

/* A function without distances, only signs: still the right ball, by bisection. */
static void test_sign_only(void)
{
    shape s = make_shape(BALL, 0, 0, 0, 0.9, 0, 0);
    scene at;
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    set_scene(&at, &s, 1, 0.15, 0);
    at.described[0].distance = sign_only;
    at.described[0].max_slope = 0;
    if (!CHECK_OK(sb_mesh_stuff(&at.def, &mesh, NULL, NULL)))
        return;
    CHECK_OK(sb_mesh_validate(&mesh, NULL));
    CHECK_NEAR(sb_mesh_volume(&mesh), 4.18879 * 0.729, 0.05);
    sb_mesh_free(&mesh);
}

/* Three sides of a tetrahedron, listed many times over: far beyond the open fourth side the winding number still holds
 * for inside. The mesh ends at the surface's box, give or take a cell. */
static void test_open_surface(void)
{
    enum { COPIES = 9 };
    static const int sides[9] = {0, 1, 3, 1, 2, 3, 2, 0, 3};
    sb_vec3 corners[4] = {
        {0, 0, 0}, {1, 0, 0}, {(sb_real)0.5, (sb_real)0.9, 0}, {(sb_real)0.5, (sb_real)0.3, (sb_real)0.8}};
    int faces[COPIES][9];
    sb_mesh soup;
    sb_surface *surface;
    scene at;
    memset(&soup, 0, sizeof soup);
    for (int k = 0; k < COPIES; k++)
        memcpy(faces[k], sides, sizeof sides);
    soup.node_count = 4;
    soup.nodes = corners;
    soup.element_type = SB_TRI3;
    soup.element_count = 3 * COPIES;
    soup.elements = faces[0];
    if (!CHECK_OK(sb_surface_create(&soup, NULL, &surface, NULL)))
        return;
    CHECK(sb_surface_inside(surface, sb_v3((sb_real)0.5, (sb_real)0.3, (sb_real)-0.7)));
    for (int cells = 2; cells < 5; cells++) {
        sb_mesh mesh;
        shape unused = make_shape(BALL, 0, 0, 0, 1, 0, 0);
        set_scene(&at, &unused, 1, (double)1 / cells, 0);
        memset(&at.described[0], 0, sizeof at.described[0]);
        at.described[0].surface = surface;
        at.def.levels = cells % 3;
        if (!CHECK_OK(sb_mesh_stuff(&at.def, &mesh, NULL, NULL)))
            continue;
        CHECK_OK(sb_mesh_validate(&mesh, NULL));
        check_closed(&mesh, 1);
        for (int i = 0; i < mesh.node_count; i++)
            CHECK(mesh.nodes[i].z > -at.def.cell && mesh.nodes[i].z < (sb_real)0.8 + at.def.cell);
        sb_mesh_free(&mesh);
    }
    sb_surface_destroy(surface);
}

/* ---- what is too thin ---- */

/* Shapes with one thin dimension, turned out of the axes; all have slope 1. */
typedef struct thin_shape {
    int kind;
    double thickness;
} thin_shape;

static sb_real thin_distance(void *user, sb_vec3 p)
{
    const thin_shape *s = (const thin_shape *)user;
    double x = 0.36 * (double)p.x + 0.48 * (double)p.y - 0.8 * (double)p.z, half = 0.5 * s->thickness, a, b, c;
    double y = -0.8 * (double)p.x + 0.6 * (double)p.y, z = 0.48 * (double)p.x + 0.64 * (double)p.y + 0.6 * (double)p.z;
    double r = sqrt(x * x + y * y), d = sqrt(r * r + z * z);
    switch (s->kind) {
    case 0: /* plate */ return REAL(fmax(fmax(fabs(x), fabs(y)) - 0.8, fabs(z) - half));
    case 1: /* shell */ return REAL(fabs(d - 0.8) - half);
    case 2: /* rod */ a = fmax(fabs(z) - 0.8, 0); return REAL(sqrt(r * r + a * a) - half);
    case 3: /* ring */ return REAL(sqrt((r - 0.7) * (r - 0.7) + z * z) - half);
    case 4: /* a ball with a brim */ return REAL(fmin(d - 0.3, fmax(fabs(z) - half, r - 0.9)));
    default: /* star of six needles */
        a = fmax(fabs(x) - 0.9, 0), b = fmax(fabs(y) - 0.9, 0), c = fmax(fabs(z) - 0.9, 0);
        a = sqrt(y * y + z * z + a * a), b = sqrt(x * x + z * z + b * b), c = sqrt(r * r + c * c);
        return REAL(fmin(a, fmin(b, c)) - half);
    }
}

/* The cell that an error names, 0: none. */
static double named_cell(const sb_error *error)
{
    const char *at = strstr(error->message, "try cells of ");
    return at ? strtod(at + 13, NULL) : 0;
}

/* Stuffs what is too thin for its cells: refused, unless most of it is kept; then as the error says, which must do. */
static void check_thin(sb_stuff_def *def, const char *name, double ratio)
{
    sb_mesh mesh;
    sb_stuff_report report;
    sb_error error;
    sb_result result;
    verdict v;
    memset(&mesh, 0, sizeof mesh);
    memset(&report, 0, sizeof report);
    result = sb_mesh_stuff(def, &mesh, &report, &error);
    if (result == SB_OK) {
        CHECK(report.volume_share[0] >= def->least_share && report.surface_share[0] >= def->least_share);
        CHECK(ratio > 0.2);
        sb_mesh_free(&mesh);
        return;
    }
    CHECK_RESULT(result, SB_ERROR_MESH);
    CHECK(mesh.nodes == NULL && report.node_count == 0);
    if (!CHECK(named_cell(&error) > 0 && named_cell(&error) < (double)def->cell)) {
        printf("%s: %s\n", name, error.message);
        return;
    }
    def->cell = REAL(named_cell(&error));
    def->levels = 2;
    if (!CHECK_OK(sb_mesh_stuff(def, &mesh, &report, &error))) {
        printf("%s, %g of a cell: %s\n", name, ratio, error.message);
        return;
    }
    CHECK(report.volume_share[0] > REAL(0.5) && report.volume_share[0] < REAL(1.3));
    CHECK(report.surface_share[0] > REAL(0.5));
    CHECK(report.min_dihedral > REAL(10.7) && report.max_dihedral < REAL(164.8));
    memset(&v, 0, sizeof v);
    check_closed(&mesh, 1);
    sb_mesh_free(&mesh);
}

static void test_thin_functions(void)
{
    static const char *const names[] = {"plate", "shell", "rod", "ring", "ball with a brim", "star"};
    for (int kind = 0; kind < 6; kind++) {
        for (int k = 0; k < (check_quick() ? 1 : 2); k++) {
            double ratio = k == 0 ? 0.3 : 0.55, cell = kind == 2 || kind == 5 ? 0.2 : 0.3;
            thin_shape thin;
            sb_shape part;
            sb_stuff_def def = sb_default_stuff_def();
            memset(&part, 0, sizeof part);
            thin.kind = kind;
            thin.thickness = ratio * cell;
            part.distance = thin_distance;
            part.user = &thin;
            part.max_slope = 1;
            def.shapes = &part;
            def.shape_count = 1;
            def.cell = REAL(cell);
            def.low = sb_v3(REAL(-1.3), REAL(-1.3), REAL(-1.3));
            def.high = sb_v3(REAL(1.3), REAL(1.3), REAL(1.3));
            check_thin(&def, names[kind], ratio);
        }
    }
}

/* Plates, a rod and a strip as surfaces. */
static void test_thin_surfaces(void)
{
    for (int kind = 0; kind < 4; kind++) {
        sb_mesh box, skin;
        sb_boundary boundary;
        sb_surface *surface = NULL;
        sb_shape part;
        sb_stuff_def def = sb_default_stuff_def();
        double t = kind == 1 ? 0.02 : 0.035, length = kind == 3 ? 0.05 : 1;
        sb_vec3 size = sb_v3(1, REAL(kind == 2 ? t : length), REAL(t));
        memset(&part, 0, sizeof part);
        memset(&skin, 0, sizeof skin);
        box = scene_box(SB_TET4, 6, 6, 1, size, 0);
        for (int v = 0; v < box.node_count; v++) { /* turned */
            sb_vec3 p = box.nodes[v];
            box.nodes[v] = sb_v3(REAL(0.6) * p.x - REAL(0.8) * p.z, p.y, REAL(0.8) * p.x + REAL(0.6) * p.z);
        }
        CHECK_OK(sb_mesh_boundary(&box, 1, NULL, &boundary, NULL));
        CHECK_OK(sb_surface_create(&boundary.surface, NULL, &surface, NULL));
        part.surface = surface;
        def.shapes = &part;
        def.shape_count = 1;
        def.cell = REAL(kind == 1 ? 0.08 : 0.1);
        check_thin(&def, "box", t / (double)def.cell);
        sb_surface_destroy(surface);
        sb_boundary_free(&boundary);
        sb_mesh_free(&box);
    }
}

/* Shares of what is thick enough are near 1, for each shape; a lost inner shape is named. */
static void test_shares(void)
{
    shape s[3];
    scene at;
    sb_mesh mesh;
    sb_stuff_report report;
    sb_error error;
    s[0] = make_shape(BALL, 0, 0, 0, 1, 0, 0);
    s[1] = make_shape(BALL, 0.1, 0, 0, 0.6, 0, 0);
    s[2] = make_shape(BALL, 0.1, 0.1, 0, 0.3, 0, 0);
    set_scene(&at, s, 3, 0.1, 0.3);
    if (CHECK_OK(sb_mesh_stuff(&at.def, &mesh, &report, NULL))) {
        for (int k = 0; k < 3; k++) {
            CHECK_NEAR(report.volume_share[k], 1, 0.12);
            CHECK_NEAR(report.surface_share[k], 1, 0.02);
        }
        sb_mesh_free(&mesh);
    }
    at.shapes[2].p[3] = 0.02;
    CHECK_RESULT(sb_mesh_stuff(&at.def, &mesh, &report, &error), SB_ERROR_MESH);
    CHECK(strstr(error.message, "of shape 2") != NULL);
    at.def.cell = REAL(named_cell(&error));
    at.def.levels = 3;
    CHECK(at.def.cell > REAL(0.01) && at.def.cell < REAL(0.05));
    at.def.cell = REAL(0.1), at.def.least_share = 0;
    if (CHECK_OK(sb_mesh_stuff(&at.def, &mesh, &report, &error)))
        sb_mesh_free(&mesh);
    at.def.least_share = REAL(1.5);
    CHECK_RESULT(sb_mesh_stuff(&at.def, &mesh, &report, &error), SB_ERROR_ARGUMENT);
}

/* Surfaces that look inward: as a whole, one part of two, with a hole. Cavities are right. */
static void test_inside_out(void)
{
    for (int k = 0; k < 5; k++) {
        sb_mesh solid, both, mesh;
        sb_boundary boundary;
        sb_surface *surface = NULL;
        sb_shape part;
        sb_stuff_def def = sb_default_stuff_def();
        sb_error error;
        sb_result result;
        sb_real shift = k == 4 ? 0 : 3, scale = k == 4 ? REAL(0.5) : 1;
        memset(&part, 0, sizeof part);
        CHECK_OK(sb_mesh_ellipsoid(SB_TET4, sb_v3(1, REAL(0.8), REAL(0.7)), 6, NULL, &solid, NULL));
        CHECK_OK(sb_mesh_boundary(&solid, 1, NULL, &boundary, NULL));
        CHECK_OK(sb_mesh_copy(&boundary.surface, NULL, &both, NULL));
        for (int v = 0; v < boundary.surface.node_count; v++)
            boundary.surface.nodes[v] = sb_v3_add(sb_v3_scale(scale, boundary.surface.nodes[v]), sb_v3(shift, 0, 0));
        if (k != 1 && k != 3)
            CHECK_OK(sb_mesh_append(&both, &boundary.surface, NULL));
        for (int e = 0; e < both.element_count; e++) { /* 0: as it is; 2: the second part; 4: as a cavity */
            int *n = both.elements + 3 * e, keep = n[1];
            if (k == 1 || k == 3 || ((k == 2 || k == 4) && e >= boundary.surface.element_count))
                n[1] = n[2], n[2] = keep;
        }
        if (k == 3)
            both.element_count -= 4; /* a hole */
        CHECK_OK(sb_surface_create(&both, NULL, &surface, NULL));
        part.surface = surface;
        def.shapes = &part;
        def.shape_count = 1;
        def.cell = REAL(0.2);
        result = sb_mesh_stuff(&def, &mesh, NULL, &error);
        CHECK_INT(result, k == 0 || k == 4 ? SB_OK : SB_ERROR_MESH);
        if (result == SB_OK)
            sb_mesh_free(&mesh);
        else
            CHECK(strstr(error.message, "inside out") != NULL && error.element >= 0);
        if (k == 2)
            CHECK(error.element >= boundary.surface.element_count);
        sb_surface_destroy(surface);
        sb_mesh_free(&both);
        sb_boundary_free(&boundary);
        sb_mesh_free(&solid);
    }
}

CHECK_SUITE(stuffing, {"thin functions", test_thin_functions}, {"thin surfaces", test_thin_surfaces},
            {"shares", test_shares}, {"inside out", test_inside_out}, {"dihedral range", test_dihedral_range},
            {"ball", test_ball}, {"graded count", test_graded_count}, {"ridges", test_ridges},
            {"aligned", test_aligned}, {"torus", test_torus}, {"random shapes", test_random_shapes},
            {"plates", test_plates}, {"clipped by box", test_clipped_by_box}, {"scale", test_scale},
            {"nested", test_nested}, {"side by side", test_side_by_side}, {"random regions", test_random_regions},
            {"surfaces", test_surfaces}, {"phantom", test_phantom}, {"body", test_body}, {"threads", test_threads},
            {"progress", test_progress}, {"allocation failures", test_allocation_failures},
            {"arguments", test_arguments}, {"element limit", test_element_limit}, {"sign only", test_sign_only},
            {"open surface", test_open_surface});
