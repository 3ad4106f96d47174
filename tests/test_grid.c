/* Immersed grids: octrees, weights and masses against volumes in closed form; bodies on them against conforming meshes,
 * closed forms and reference solutions; rows of points; failures. What takes long runs with CHECK_SLOW=1. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

static const double pi = 3.14159265358979323846;

/* ---- shapes ---- */

typedef struct solid {
    sb_vec3 centre;
    double radius, length; /* of a ball (length 0), or of a cylinder along z from the centre */
    sb_vec3 half;          /* of a box (radius 0) */
} solid;

static double box_distance(const double *q, int axes)
{
    double outside = 0, inside = -HUGE_VAL;
    for (int i = 0; i < axes; i++) {
        outside += q[i] > 0 ? q[i] * q[i] : 0;
        inside = fmax(inside, q[i]);
    }
    return inside < 0 ? inside : sqrt(outside);
}

static sb_real solid_distance(void *user, sb_vec3 point)
{
    const solid *s = (const solid *)user;
    double x = (double)point.x - (double)s->centre.x, y = (double)point.y - (double)s->centre.y,
           z = (double)point.z - (double)s->centre.z;
    if (s->radius > 0 && s->length > 0) {
        const double q[2] = {sqrt(x * x + y * y) - s->radius, fabs(z - s->length / 2) - s->length / 2};
        return REAL(box_distance(q, 2));
    }
    if (s->radius > 0)
        return REAL(sqrt(x * x + y * y + z * z) - s->radius);
    {
        const double q[3] = {fabs(x) - (double)s->half.x, fabs(y) - (double)s->half.y, fabs(z) - (double)s->half.z};
        return REAL(box_distance(q, 3));
    }
}

static solid make_ball(sb_vec3 centre, double radius)
{
    solid s;
    memset(&s, 0, sizeof s);
    s.centre = centre;
    s.radius = radius;
    return s;
}

static solid make_cylinder(double radius, double length)
{
    solid s = make_ball(sb_v3(0, 0, 0), radius);
    s.length = length;
    return s;
}

static solid make_box(sb_vec3 low, sb_vec3 high)
{
    solid s = make_ball(sb_v3_scale(REAL(0.5), sb_v3_add(low, high)), 0);
    s.half = sb_v3_scale(REAL(0.5), sb_v3_sub(high, low));
    return s;
}

static sb_shape make_shape(solid *s, int region)
{
    sb_shape shape;
    memset(&shape, 0, sizeof shape);
    shape.distance = solid_distance;
    shape.max_slope = 1;
    shape.user = s;
    shape.region = region;
    return shape;
}

/* Def for a solid in a grid from low to high with these counts. */
static sb_grid_def make_def(solid *s, sb_vec3 low, sb_vec3 high, int nx, int ny, int nz)
{
    sb_grid_def def = sb_default_grid_def();
    def.outer = make_shape(s, 0);
    def.low = low;
    def.high = high;
    def.counts[0] = nx;
    def.counts[1] = ny;
    def.counts[2] = nz;
    return def;
}

static sb_grid make_grid(const sb_grid_def *def)
{
    sb_grid grid;
    sb_error error;
    memset(&grid, 0, sizeof grid);
    if (!CHECK_OK(sb_grid_create(def, &grid, &error)))
        printf("    %s\n", error.message);
    return grid;
}

static sb_body_def grid_body_def(const sb_grid *grid, sb_material material)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = &grid->body_mesh;
    def.domain = &grid->domain;
    def.material = material;
    return def;
}

static double sum_weights(const sb_grid *grid)
{
    double sum = 0;
    for (int i = 0; i < 8 * grid->domain.cell_count; i++)
        sum += (double)grid->domain.weights[i];
    return sum;
}

/* int x^i dV with the masses: sum_ab m_ab x_a^(i > 0) x_b^(i > 1), exact for what is linear in each coordinate. */
static double sum_masses(const sb_grid *grid, int axis, int power)
{
    double sum = 0;
    for (int e = 0; e < grid->domain.cell_count; e++) {
        const sb_real *mass = grid->domain.cell_mass + 36 * e;
        for (int a = 0; a < 8; a++)
            for (int b = a; b < 8; b++, mass++) {
                double xa = (double)scene_component(grid->mesh.nodes[grid->domain.cells[8 * e + a]], axis);
                double xb = (double)scene_component(grid->mesh.nodes[grid->domain.cells[8 * e + b]], axis);
                double value = power == 0 ? 1 : power == 1 ? 0.5 * (xa + xb) : xa * xb;
                sum += (a == b ? 1 : 2) * value * (double)*mass;
            }
    }
    return sum;
}

/* ---- volumes ---- */

/* Volume, moments and weights of a ball and a cylinder: closer with each level, and consistent with each other. */
static void test_volumes(void)
{
    static const double round[6] = {1, 6e-2, 1.5e-2, 4e-3, 1.2e-3, 4e-4};
    for (int shape = 0; shape < 2; shape++)
        for (int method = SB_GRID_FINITE_CELL; method <= SB_GRID_WEIGHTED_CELL; method++)
            for (int level = 1; level <= (method == SB_GRID_FINITE_CELL ? 3 : 5); level++) {
                solid s =
                    shape ? make_cylinder(0.05, 0.12) : make_ball(sb_v3(REAL(0.003), REAL(-0.002), REAL(0.005)), 0.05);
                sb_grid_def def = make_def(&s, sb_v3(REAL(-0.061), REAL(-0.063), REAL(-0.06)),
                                           sb_v3(REAL(0.064), REAL(0.062), shape ? REAL(0.13) : REAL(0.065)), 6, 6, 6);
                double exact = shape ? pi * 0.0025 * 0.12 : 4.0 / 3 * pi * 0.000125, volume;
                double second = shape ? exact * 0.0025 / 4 : exact * (0.0025 / 5 + 0.003 * 0.003);
                /* a flat end that lies as the grid does jumps over a layer of points at once: a third of a leaf */
                double bound = round[level] + (shape ? 0.35 * (0.13 / 6) / (1 << level) / 0.12 : 0);
                sb_grid grid;
                def.method = (sb_grid_method)method;
                def.level = level;
                def.void_stiffness = 0;
                grid = make_grid(&def);
                volume = (double)grid.volume;
                CHECK_NEAR(volume, exact, bound * exact);
                CHECK_NEAR(sum_weights(&grid), volume, scene_tolerance(1e-12, 50) * volume);
                CHECK_NEAR(sum_masses(&grid, 0, 0), volume, scene_tolerance(1e-12, 50) * volume);
                CHECK_NEAR(sum_masses(&grid, 0, 1), shape ? 0 : 0.003 * exact, 0.2 * bound * 0.05 * exact);
                CHECK_NEAR(sum_masses(&grid, 0, 2), second, 2 * bound * second);
                sb_grid_free(&grid);
            }
}

/* Kept cells are those that touch the inside, whatever the level; weighted cells have the same points at all of
 * them. */
static void test_cells_do_not_depend_on_level(void)
{
    solid s = make_cylinder(0.05, 0.12);
    int cells = 0, nodes = 0;
    for (int level = 0; level <= 4; level++) {
        sb_grid_def def = make_def(&s, sb_v3(REAL(-0.0567), REAL(-0.0567), REAL(-0.01)),
                                   sb_v3(REAL(0.0633), REAL(0.0633), REAL(0.14)), 6, 6, 7);
        sb_grid grid;
        sb_body_def body_def;
        sb_body *body;
        double low = 1;
        def.level = level;
        grid = make_grid(&def);
        body_def = grid_body_def(&grid, sb_material_neo_hookean(REAL(5000), REAL(0.3), REAL(1000)));
        body = scene_body(&body_def);
        if (level == 0) {
            cells = grid.mesh.element_count;
            nodes = grid.mesh.node_count;
            CHECK_NEAR(sum_weights(&grid), cells * 0.02 * 0.02 * 0.15 / 7, scene_tolerance(1e-12, 50));
        }
        CHECK_INT(grid.mesh.element_count, cells);
        CHECK_INT(grid.mesh.node_count, nodes);
        CHECK_INT(grid.body_mesh.element_count, cells);
        CHECK_INT(sb_body_element_count(body) * sb_body_point_count(body), 8 * cells);
        for (int e = 0; e < cells; e++) {
            CHECK(grid.body_cells[e] == e && grid.shares[e] > 0 && grid.shares[e] <= REAL(1.0000001));
            low = fmin(low, (double)grid.shares[e]);
        }
        CHECK(level == 0 ? low == 1 : low < 0.1);
        sb_body_destroy(body);
        sb_grid_free(&grid);
    }
}

/* A block that fills its cells to the faces is the plain mesh, for every method: what is cut is full. */
static void test_aligned_block_is_plain_mesh(void)
{
    sb_vec3 size = sb_v3(REAL(0.08), REAL(0.04), REAL(0.04));
    sb_mesh mesh = scene_box(SB_HEX8, 4, 2, 2, size, 0);
    sb_body_def plain = sb_default_body_def();
    sb_body *twin;
    plain.mesh = &mesh;
    plain.material = sb_material_linear(REAL(1e4), REAL(0.3), REAL(1000));
    plain.gravity = sb_v3(0, 0, REAL(-9.81));
    plain.mass = SB_MASS_CONSISTENT;
    plain.tolerance = REAL(1e-9);
    twin = scene_body(&plain);
    scene_fix_plane(twin, &mesh, 0, 0, SB_XYZ);
    for (int s = 0; s < 3; s++)
        CHECK_OK(sb_body_step(twin, REAL(0.02), NULL));
    for (int method = SB_GRID_SPARSE; method <= SB_GRID_WEIGHTED_CELL; method++) {
        solid s = make_box(sb_v3(0, 0, 0), size);
        /* a row of cells around, which all stay empty */
        sb_grid_def def = make_def(&s, sb_v3(REAL(-0.02), REAL(-0.02), REAL(-0.02)),
                                   sb_v3(REAL(0.1), REAL(0.06), REAL(0.06)), 6, 4, 4);
        sb_grid grid;
        sb_body_def body_def;
        sb_body *body;
        def.method = (sb_grid_method)method;
        def.level = 2;
        grid = make_grid(&def);
        CHECK_INT(grid.mesh.element_count, 16);
        CHECK_NEAR(grid.volume, 0.08 * 0.04 * 0.04, scene_tolerance(1e-14, 1e-2));
        body_def = plain;
        body_def.mesh = &grid.body_mesh;
        body_def.domain = &grid.domain;
        body = scene_body(&body_def);
        scene_fix_plane(body, &grid.body_mesh, 0, 0, SB_XYZ);
        for (int k = 0; k < 3; k++)
            CHECK_OK(sb_body_step(body, REAL(0.02), NULL));
        CHECK_INT(grid.mesh.node_count, mesh.node_count); /* in the same order: x fastest */
        CHECK_NEAR(scene_distance(grid.mesh.nodes, mesh.nodes, mesh.node_count), 0, 1e-7);
        CHECK_NEAR(scene_distance(sb_body_displacements(body), sb_body_displacements(twin), mesh.node_count), 0,
                   scene_tolerance(1e-9, 1000) * (double)sb_v3_norm(sb_body_displacements(twin)[mesh.node_count - 1]));
        sb_body_destroy(body);
        sb_grid_free(&grid);
    }
    sb_body_destroy(twin);
    sb_mesh_free(&mesh);
}

/* ---- surfaces ---- */

static sb_mesh ball_surface(double radius, int cells)
{
    sb_mesh volume, surface;
    sb_boundary boundary;
    memset(&volume, 0, sizeof volume);
    memset(&surface, 0, sizeof surface);
    CHECK_OK(sb_mesh_ellipsoid(SB_TET4, sb_v3(REAL(radius), REAL(radius), REAL(radius)), cells, NULL, &volume, NULL));
    CHECK_OK(sb_mesh_boundary(&volume, 1, NULL, &boundary, NULL));
    CHECK_OK(sb_mesh_copy(&boundary.surface, NULL, &surface, NULL));
    sb_boundary_free(&boundary);
    sb_mesh_free(&volume);
    return surface;
}

static unsigned long long hash_grid(const sb_grid *grid)
{
    size_t cells = (size_t)grid->domain.cell_count;
    return scene_hash(grid->domain.weights, cells * 8 * sizeof(sb_real)) ^
           3 * scene_hash(grid->domain.gradients, cells * 192 * sizeof(sb_real)) ^
           5 * scene_hash(grid->domain.cell_mass, cells * 36 * sizeof(sb_real)) ^
           7 * scene_hash(grid->body_mesh.elements, cells * 8 * sizeof(int)) ^
           9 * scene_hash(grid->mesh.nodes, (size_t)grid->mesh.node_count * sizeof(sb_vec3)) ^
           11 * scene_hash(grid->shares, (size_t)grid->mesh.element_count * sizeof(sb_real));
}

static int count_progress(void *user, double share)
{
    double *last = (double *)user;
    CHECK(share > *last && share <= 1 + 1e-12);
    *last = share;
    return 0;
}

/* Stops once half is done. */
static int stop_progress(void *user, double share)
{
    (void)user;
    return share > 0.5;
}

/* Two balls that overlap, in one surface: the grid is their union, though the nearest triangle often lies inside. */
static void test_crossing_surface(void)
{
    const double radius = 0.05, apart = 0.04;
    sb_mesh mesh = ball_surface(radius, 10), other = ball_surface(radius, 10);
    sb_surface *surface = NULL;
    double ball = (double)sb_mesh_volume(&mesh), cap = radius - apart / 2;
    double lens = 2 * 3.14159265358979323846 * cap * cap * (3 * radius - cap) / 3;
    for (int i = 0; i < other.node_count; i++)
        other.nodes[i].x += REAL(apart);
    CHECK_OK(sb_mesh_append(&mesh, &other, NULL));
    CHECK_OK(sb_surface_create(&mesh, NULL, &surface, NULL));
    for (int method = SB_GRID_FINITE_CELL; method <= SB_GRID_WEIGHTED_CELL; method++) {
        sb_grid_def def = sb_default_grid_def();
        sb_grid grid;
        def.outer.surface = surface;
        def.cells = 8;
        def.level = 2;
        def.method = (sb_grid_method)method;
        grid = make_grid(&def);
        CHECK_NEAR(grid.volume, 2 * ball - lens, 0.03 * ball);
        sb_grid_free(&grid);
    }
    sb_surface_destroy(surface);
    sb_mesh_free(&mesh);
    sb_mesh_free(&other);
}

/* A function whose slope nobody knows gives the grid that a distance gives, only later. */
static void test_unknown_slope(void)
{
    solid ball = make_ball(sb_v3(0, 0, 0), 0.05);
    sb_grid_def def = make_def(&ball, sb_v3(REAL(-0.06), REAL(-0.06), REAL(-0.06)),
                               sb_v3(REAL(0.06), REAL(0.06), REAL(0.06)), 6, 6, 6);
    for (int method = SB_GRID_FINITE_CELL; method <= SB_GRID_WEIGHTED_CELL; method++) {
        sb_grid known, unknown;
        def.method = (sb_grid_method)method;
        def.level = 2;
        def.outer.max_slope = 1;
        known = make_grid(&def);
        def.outer.max_slope = 0;
        unknown = make_grid(&def);
        CHECK_INT(unknown.mesh.element_count, known.mesh.element_count);
        CHECK_NEAR(unknown.volume, known.volume, scene_tolerance(1e-12, 100) * (double)known.volume);
        sb_grid_free(&known);
        sb_grid_free(&unknown);
    }
}

/* Grids of surfaces: their volume is the surface's; the bits do not depend on the threads; progress rises to 1. */
static void test_surfaces_and_jobs(void)
{
    sb_mesh mesh = ball_surface(0.05, 12);
    sb_surface *surface = NULL;
    unsigned long long hash = 0;
    CHECK_OK(sb_surface_create(&mesh, NULL, &surface, NULL));
    for (int method = SB_GRID_SPARSE; method <= SB_GRID_WEIGHTED_CELL; method++)
        for (int workers = 1; workers <= 3; workers += 2) {
            sb_grid_def def = sb_default_grid_def();
            sb_grid grid;
            double last = 0, volume = (double)sb_mesh_volume(&mesh);
            def.outer.surface = surface;
            def.cells = 5;
            def.method = (sb_grid_method)method;
            def.level = 3;
            def.progress = count_progress;
            def.progress_user = &last;
            if (workers > 1)
                def.jobs = scene_jobs(&workers);
            grid = make_grid(&def);
            CHECK_NEAR(last, 1, 1e-12);
            CHECK_INT(grid.counts[0], 5);
            CHECK_NEAR(grid.cell_size.x, 0.02, scene_tolerance(1e-10, 1));
            if (method == SB_GRID_SPARSE)
                CHECK((double)grid.volume > 1.2 * volume);
            else
                CHECK_NEAR(grid.volume, volume, 3e-3 * volume);
            CHECK(workers == 1 || hash_grid(&grid) == hash);
            hash = hash_grid(&grid);
            sb_grid_free(&grid);
        }
    sb_surface_destroy(surface);
    sb_mesh_free(&mesh);
}

/* A surface with a hole is still an inside: its distances take their sign from the winding number. */
static void test_open_surface(void)
{
    sb_mesh mesh = ball_surface(0.05, 12);
    double volume = (double)sb_mesh_volume(&mesh);
    sb_surface *surface = NULL;
    sb_grid_def def = sb_default_grid_def();
    sb_grid grid;
    mesh.element_count -= 2;
    CHECK_OK(sb_surface_create(&mesh, NULL, &surface, NULL));
    CHECK(!sb_surface_is_closed(surface));
    def.outer.surface = surface;
    def.cells = 5;
    grid = make_grid(&def);
    CHECK_NEAR(grid.volume, volume, 1e-2 * volume);
    sb_grid_free(&grid);
    sb_surface_destroy(surface);
    mesh.element_count += 2;
    sb_mesh_free(&mesh);
}

/* ---- explicit steps ---- */

/* Stable step (s) of a body in the grid; its mass, and where its centre of mass and second moments about the origin are
 * (kg, m, kg m^2), from what free fall and a spin make of them. */
typedef struct inertia {
    double step, mass, centre[3], spin;
} inertia;

static inertia measure_inertia(const sb_grid *grid, sb_mass_kind kind)
{
    sb_body_def def = grid_body_def(grid, sb_material_linear(REAL(5e3), REAL(0.3), REAL(1000)));
    inertia found;
    sb_real step = 0;
    sb_energy energy;
    int n = grid->body_mesh.node_count;
    sb_vec3 *v = (sb_vec3 *)calloc((size_t)n, sizeof *v);
    sb_body *body;
    def.mass = kind;
    body = scene_body(&def);
    memset(&found, 0, sizeof found);
    if (kind == SB_MASS_LUMPED)
        CHECK_OK(sb_body_stable_step(body, &step, NULL));
    found.step = (double)step;
    found.mass = (double)sb_body_mass(body);
    for (int axis = 0; axis < 3; axis++) { /* momentum of a velocity x along each axis: mass times centre */
        for (int i = 0; i < n; i++)
            v[i] = sb_v3(scene_component(grid->mesh.nodes[i], axis), 0, 0);
        CHECK_OK(sb_body_set_velocities(body, v));
        found.centre[axis] = (double)sb_body_momentum(body).x / found.mass;
    }
    for (int i = 0; i < n; i++)
        v[i] = sb_v3_cross(sb_v3(0, 0, 1), grid->mesh.nodes[i]);
    CHECK_OK(sb_body_set_velocities(body, v));
    CHECK_OK(sb_body_energy(body, &energy));
    found.spin = 2 * (double)energy.kinetic;
    sb_body_destroy(body);
    free(v);
    return found;
}

/* However the surface cuts the grid: steps nearly as long as those of full cells, all of the mass, its centre where it
 * is, and its second moment nearly so. */
static void test_explicit_steps_of_cut_cells(void)
{
    static const double voids[] = {1e-4, 0, 1e-2};
    unsigned long long seed = 5;
    solid block = make_box(sb_v3(REAL(-1), REAL(-1), REAL(-1)), sb_v3(2, 2, 2));
    sb_grid_def def = make_def(&block, sb_v3(0, 0, 0), sb_v3(1, 1, 1), 6, 6, 6);
    sb_grid grid = make_grid(&def);
    inertia full = measure_inertia(&grid, SB_MASS_LUMPED);
    double worst = 1, spin = 0;
    sb_grid_free(&grid);
    for (int k = 0; k < (check_quick() ? 6 : 24); k++) {
        double thin = pow(10, check_random_in(&seed, -6, -0.3)) / 6; /* what sticks into the last cells */
        double from = 1.0 / 6 - thin, to = 5.0 / 6 + thin;
        sb_vec3 middle =
            sb_v3(REAL(check_random_in(&seed, 0.45, 0.55)), REAL(check_random_in(&seed, 0.45, 0.55)), REAL(0.5));
        solid s = k % 2
                      ? make_ball(middle, check_random_in(&seed, 0.3, 0.44))
                      : make_box(sb_v3(REAL(from), REAL(from), REAL(from)), sb_v3(REAL(to), REAL(5.0 / 6), REAL(0.7)));
        inertia found, exact;
        def.outer = make_shape(&s, 0);
        def.method = k / 2 % 2 ? SB_GRID_FINITE_CELL : SB_GRID_WEIGHTED_CELL;
        def.void_stiffness = REAL(voids[k / 4 % 3]);
        grid = make_grid(&def);
        found = measure_inertia(&grid, SB_MASS_LUMPED);
        exact = measure_inertia(&grid, SB_MASS_CONSISTENT);
        worst = fmin(worst, found.step / full.step);
        spin = fmax(spin, fabs(found.spin / exact.spin - 1));
        CHECK_NEAR(found.mass / exact.mass, 1, scene_tolerance(1e-12, 100));
        for (int axis = 0; axis < 3; axis++)
            CHECK_NEAR(found.centre[axis], exact.centre[axis], scene_tolerance(1e-10, 1e3));
        sb_grid_free(&grid);
    }
    printf("  cut cells: explicit steps of at least %.2f of full cells', second moments to %.1f %%\n", worst,
           100 * spin);
    CHECK(worst > 0.6);
    CHECK_NEAR(spin, 0, 0.03);
}

static sb_result refused(const sb_grid_def *def, const char *words)
{
    sb_grid grid;
    sb_error error;
    sb_result result;
    memset(&grid, 0x55, sizeof grid);
    result = sb_grid_create(def, &grid, &error);
    CHECK(grid.cut_count == 0x55555555);
    if (!CHECK(result != SB_OK && strstr(error.message, words) != NULL))
        printf("    %s\n", result == SB_OK ? "accepted" : error.message);
    return result;
}

/* Its outside would be the body: all of the box but the ball. As outer shape and as a tumour. */
static void test_inside_out(void)
{
    sb_mesh mesh = ball_surface(0.05, 12), small = ball_surface(0.02, 12);
    sb_surface *surface = NULL, *tumour = NULL;
    sb_grid_def def = sb_default_grid_def();
    sb_shape inner;
    memset(&inner, 0, sizeof inner);
    for (int t = 0; t < small.element_count; t++) {
        int *nodes = small.elements + 3 * (size_t)t, swap = nodes[1];
        nodes[1] = nodes[2];
        nodes[2] = swap;
    }
    if (CHECK_OK(sb_surface_create(&mesh, NULL, &surface, NULL)) &&
        CHECK_OK(sb_surface_create(&small, NULL, &tumour, NULL))) {
        def.cells = 5;
        def.outer.surface = tumour;
        CHECK_RESULT(refused(&def, "def.outer is inside out"), SB_ERROR_MESH);
        inner.surface = tumour;
        def.outer.surface = surface;
        def.inner = &inner;
        def.inner_count = 1;
        CHECK_RESULT(refused(&def, "an inner shape is inside out"), SB_ERROR_MESH);
    }
    sb_surface_destroy(surface);
    sb_surface_destroy(tumour);
    sb_mesh_free(&mesh);
    sb_mesh_free(&small);
}

/* The same at a thousandth and a thousand times the size. */
static void test_scale(void)
{
    int cells[3];
    double shares[3];
    for (int k = 0; k < 3; k++) {
        double scale = k == 0 ? 1e-3 : k == 1 ? 1 : 1e3;
        solid s = make_ball(sb_v3(0, 0, 0), 0.05 * scale);
        double reach = 0.0513 * scale;
        sb_grid_def def = make_def(&s, sb_v3(REAL(-reach), REAL(-reach), REAL(-reach)),
                                   sb_v3(REAL(reach), REAL(reach), REAL(reach)), 5, 5, 5);
        sb_grid grid = make_grid(&def);
        cells[k] = grid.mesh.element_count;
        shares[k] = (double)grid.volume / (scale * scale * scale);
        sb_grid_free(&grid);
    }
    CHECK(cells[0] == cells[1] && cells[2] == cells[1]);
    CHECK_NEAR(shares[0], shares[1], scene_tolerance(1e-12, 1e4) * shares[1]);
    CHECK_NEAR(shares[2], shares[1], scene_tolerance(1e-12, 1e4) * shares[1]);
}

/* ---- regions ---- */

/* A ball with a ball inside it, a hole in that, and another region that sticks out: volumes in closed form. */
static void test_regions(void)
{
    for (int method = SB_GRID_FINITE_CELL; method <= SB_GRID_WEIGHTED_CELL; method++) {
        solid outer = make_ball(sb_v3(0, 0, 0), 0.05), tumour = make_ball(sb_v3(REAL(0.01), 0, 0), 0.025),
              hole = make_ball(sb_v3(REAL(0.01), 0, 0), 0.012),
              half = make_box(sb_v3(REAL(-0.1), REAL(-0.1), REAL(-0.1)), sb_v3(REAL(-0.03), REAL(0.1), REAL(0.1)));
        sb_shape inner[4];
        sb_grid_def def = make_def(&outer, sb_v3(REAL(-0.05), REAL(-0.05), REAL(-0.05)),
                                   sb_v3(REAL(0.05), REAL(0.05), REAL(0.05)), 7, 7, 7);
        double cap = pi * 0.02 * 0.02 * (0.15 - 0.02) / 3, ball = 4.0 / 3 * pi, volumes[3], mass = 0;
        sb_grid grid;
        sb_body_def body_def;
        sb_body *body;
        sb_region_material materials[2];
        inner[0] = make_shape(&tumour, 7);
        inner[1] = make_shape(&hole, SB_GRID_EMPTY);
        inner[2] = make_shape(&half, 3);
        inner[3] = make_shape(&half, 3); /* the same region once more */
        def.inner = inner;
        def.inner_count = 4;
        def.method = (sb_grid_method)method;
        def.level = 3;
        def.outer.region = 1;
        grid = make_grid(&def);
        volumes[2] = cap;
        volumes[1] = ball * (pow(0.025, 3) - pow(0.012, 3));
        volumes[0] = ball * (pow(0.05, 3) - pow(0.025, 3)) - cap;
        CHECK_INT(grid.region_count, 3);
        CHECK(grid.regions[0] == 1 && grid.regions[1] == 7 && grid.regions[2] == 3);
        for (int r = 0; r < 3; r++)
            CHECK_NEAR(grid.region_volumes[r], volumes[r],
                       6e-3 * volumes[r] + (r == 1 ? 0 : 0.35 * 0.1 / 7 / 8 * pi * 0.04 * 0.04)); /* the flat side */
        body_def = grid_body_def(&grid, sb_material_corotated(REAL(5000), REAL(0.3), REAL(1000)));
        materials[0].region = 7;
        materials[0].material = sb_material_corotated(REAL(20000), REAL(0.3), REAL(2000));
        materials[1].region = 3;
        materials[1].material = sb_material_corotated(REAL(5000), REAL(0.3), REAL(500));
        body_def.region_materials = materials;
        body_def.region_material_count = 2;
        body = scene_body(&body_def);
        for (int r = 0; r < 3; r++)
            mass += (r == 0 ? 1000 : r == 1 ? 2000 : 500) * (double)grid.region_volumes[r];
        CHECK_NEAR(sb_body_mass(body), mass, scene_tolerance(1e-10, 100) * mass);
        for (int e = 0; e < grid.mesh.element_count; e++) { /* the region of the picture is one that the cell has */
            int found = 0;
            for (int b = 0; b < grid.body_mesh.element_count; b++)
                found |= grid.body_cells[b] == e && grid.body_mesh.regions[b] == grid.mesh.regions[e];
            CHECK(found);
        }
        sb_body_destroy(body);
        sb_grid_free(&grid);
    }
}

/* Mean displacement of a bar's end under a pull: two materials one after the other (interface at `cut` of the length),
 * or side by side. nu is 0, so that closed forms are exact. */
static double pull_bar(int method, int level, int side_by_side, double cut)
{
    const double length = 0.12, width = 0.04, pull = 10; /* m, m, Pa */
    solid bar = make_box(sb_v3(0, 0, 0), sb_v3(REAL(length), REAL(width), REAL(width))), other;
    sb_shape inner;
    sb_grid_def def = make_def(&bar, sb_v3(0, 0, 0), sb_v3(REAL(length), REAL(width), REAL(width)), 12, 4, 4);
    sb_region_material stiff;
    sb_body_def body_def;
    sb_body *body;
    sb_grid grid;
    sb_vec3 force = sb_v3(REAL(pull * width * width / 16), 0, 0);
    double mean = 0, weight = 0;
    other = side_by_side ? make_box(sb_v3(-1, REAL(cut * width), -1), sb_v3(1, 1, 1))
                         : make_box(sb_v3(REAL(cut * length), -1, -1), sb_v3(1, 1, 1));
    inner = make_shape(&other, 1);
    def.inner = &inner;
    def.inner_count = 1;
    def.method = (sb_grid_method)method;
    def.level = level;
    grid = make_grid(&def);
    body_def = grid_body_def(&grid, sb_material_linear(REAL(1000), 0, REAL(1000)));
    stiff.region = 1;
    stiff.material = sb_material_linear(REAL(5000), 0, REAL(1000));
    body_def.region_materials = &stiff;
    body_def.region_material_count = 1;
    body = scene_body(&body_def);
    scene_fix_plane(body, &grid.body_mesh, 0, 0, SB_XYZ);
    if (side_by_side) { /* held flat, as bars that are bonded do not stay */
        for (int i = 0; i < grid.mesh.node_count; i++)
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_Y | SB_Z));
        for (int i = 0; i < grid.mesh.node_count; i++)
            if ((double)grid.mesh.nodes[i].x > length - 1e-6) {
                sb_vec3 target = sb_v3(REAL(0.001), 0, 0);
                CHECK_OK(sb_body_prescribe(body, &i, 1, SB_X, &target, 1));
            }
    } else {
        for (int i = 0; i < grid.mesh.node_count; i++)
            if ((double)grid.mesh.nodes[i].x > length - 1e-6) {
                sb_vec3 x = grid.mesh.nodes[i];
                int edges = ((double)x.y < 1e-6 || (double)x.y > width - 1e-6) +
                            ((double)x.z < 1e-6 || (double)x.z > width - 1e-6);
                sb_vec3 share = sb_v3_scale(edges == 0 ? 1 : edges == 1 ? REAL(0.5) : REAL(0.25), force);
                CHECK_OK(sb_body_add_forces(body, &i, 1, &share, 1));
            }
    }
    CHECK_OK(sb_body_solve_static(body, NULL, NULL));
    for (int i = 0; i < grid.mesh.node_count; i++)
        if ((double)grid.mesh.nodes[i].x > length - 1e-6) {
            mean += side_by_side ? (double)sb_body_reactions(body)[i].x : (double)sb_body_displacements(body)[i].x;
            weight += 1;
        }
    sb_body_destroy(body);
    sb_grid_free(&grid);
    return side_by_side ? mean : mean / weight;
}

static void test_two_materials(void)
{
    const double length = 0.12, width = 0.04, pull = 10;
    double worst_wc = 0, worst_fc = 0;
    for (int k = 0; k < 4; k++) {
        double cut = (5 + 0.25 * k) / 12; /* on a face of cells, and at quarters of one */
        double exact = pull * length * (cut / 1000 + (1 - cut) / 5000);
        double wc = pull_bar(SB_GRID_WEIGHTED_CELL, 3, 0, cut), fc = pull_bar(SB_GRID_FINITE_CELL, 2, 0, cut);
        double plain = k ? 0.06 : scene_tolerance(1e-6, 1e3); /* of a cell's own length: the strain jumps within it */
        worst_wc = fmax(worst_wc, fabs(wc - exact) / exact);
        worst_fc = fmax(worst_fc, fabs(fc - exact) / exact);
        CHECK_NEAR(wc, exact, plain * exact);
        CHECK_NEAR(fc, exact, plain * exact);
    }
    printf("two materials in a row, interface within a cell of 12: weighted cell %.2f %%, finite cell %.2f %% off\n",
           100 * worst_wc, 100 * worst_fc);
    for (int k = 0; k < 3; k++) {
        double cut = (2 + 0.25 * k) / 4; /* level 3 sees quarters of a cell exactly */
        double exact = 0.001 / length * width * width * (cut * 1000 + (1 - cut) * 5000);
        CHECK_NEAR(pull_bar(SB_GRID_WEIGHTED_CELL, 3, 1, cut), exact, scene_tolerance(2e-4, 1e3) * exact);
        CHECK_NEAR(pull_bar(SB_GRID_FINITE_CELL, 2, 1, cut), exact, scene_tolerance(2e-4, 1e3) * exact);
    }
}

/* ---- rows ---- */

static void test_rows(void)
{
    solid s = make_ball(sb_v3(0, 0, 0), 0.05);
    sb_mesh surface = ball_surface(0.05, 10);
    sb_grid_def def =
        make_def(&s, sb_v3(REAL(-0.05), REAL(-0.05), REAL(-0.05)), sb_v3(REAL(0.05), REAL(0.05), REAL(0.05)), 3, 4, 5);
    sb_grid grid = make_grid(&def);
    sb_grid_rows points, patch;
    sb_vec3 far[2], *out = (sb_vec3 *)malloc((size_t)surface.node_count * sizeof(sb_vec3));
    sb_vec3 *forces = (sb_vec3 *)calloc((size_t)grid.mesh.node_count, sizeof(sb_vec3)), force = sb_v3(0, 0, 0),
            moment = force, traction = sb_v3(REAL(3), REAL(-7), REAL(11));
    sb_error error;
    double area = 0, scale = 0.05;
    /* rows give positions back, outside of the kept cells too */
    CHECK_OK(sb_grid_map_points(&grid, surface.nodes, surface.node_count, NULL, &points, &error));
    sb_mapping_apply(&points.rows, grid.mesh.nodes, out);
    CHECK_NEAR(scene_distance(out, surface.nodes, surface.node_count), 0, 20 * (double)SB_EPSILON * scale);
    CHECK(points.farthest < REAL(1e-6));
    for (int j = 0; j < points.rows.row_count; j++) {
        int e = points.cells[j];
        sb_vec3 low = grid.mesh.nodes[grid.mesh.elements[8 * e]], high = grid.mesh.nodes[grid.mesh.elements[8 * e + 6]];
        sb_vec3 x = points.points[j];
        double rim = 1e-6;
        CHECK((double)x.x > (double)low.x - rim && (double)x.x < (double)high.x + rim &&
              (double)x.y > (double)low.y - rim && (double)x.y < (double)high.y + rim &&
              (double)x.z > (double)low.z - rim && (double)x.z < (double)high.z + rim);
    }
    sb_grid_rows_free(&points);
    far[0] = sb_v3(REAL(0.06), REAL(0.01), 0);
    far[1] = sb_v3(REAL(0.05), REAL(0.05), REAL(0.05)); /* its own cell is dropped */
    CHECK_OK(sb_grid_map_points(&grid, far, 2, NULL, &points, &error));
    sb_mapping_apply(&points.rows, grid.mesh.nodes, out);
    CHECK_NEAR(scene_distance(out, far, 2), 0, 100 * (double)SB_EPSILON * scale);
    CHECK((double)points.farthest > 0.0099);
    sb_grid_rows_free(&points);
    /* a traction's force and moment */
    CHECK_OK(sb_grid_map_surface(&grid, &surface, NULL, 0, NULL, &patch, &error));
    for (int j = 0; j < patch.rows.row_count; j++) {
        area += (double)patch.areas[j];
        CHECK_NEAR(sb_v3_norm(patch.normals[j]), 1, 10 * (double)SB_EPSILON);
        CHECK(sb_v3_dot(patch.normals[j], patch.points[j]) > 0);
    }
    CHECK_NEAR(area, sb_mesh_surface_area(&surface), scene_tolerance(1e-12, 200) * area);
    sb_grid_add_traction(&patch, &traction, 1, forces);
    for (int i = 0; i < grid.mesh.node_count; i++) {
        force = sb_v3_add(force, forces[i]);
        moment = sb_v3_add(moment, sb_v3_cross(sb_v3_sub(grid.mesh.nodes[i], sb_v3(1, 2, 3)), forces[i]));
    }
    CHECK_NEAR(sb_v3_norm(sb_v3_madd(force, REAL(-area), traction)), 0, scene_tolerance(1e-12, 200) * area * 13);
    /* centre of area of the surface: 0 by symmetry to rounding is not sure, so it is summed from the triangles */
    {
        sb_vec3 expected = sb_v3(0, 0, 0);
        for (int t = 0; t < surface.element_count; t++) {
            const int *n = surface.elements + 3 * t;
            sb_vec3 a = surface.nodes[n[0]], b = surface.nodes[n[1]], c = surface.nodes[n[2]];
            sb_real part = sb_v3_norm(sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(c, a))) / 2;
            sb_vec3 middle = sb_v3_scale(REAL(1.0 / 3), sb_v3_add(a, sb_v3_add(b, c)));
            expected = sb_v3_add(expected, sb_v3_cross(sb_v3_sub(middle, sb_v3(1, 2, 3)), sb_v3_scale(part, traction)));
        }
        CHECK_NEAR(sb_v3_norm(sb_v3_sub(moment, expected)), 0, scene_tolerance(1e-12, 200) * area * 50);
    }
    sb_grid_rows_free(&patch);
    free(out);
    free(forces);
    sb_grid_free(&grid);
    sb_mesh_free(&surface);
}

/* Triangles much larger than cells are cut: the load on a face of a block is that of the faces of its cells. */
static void test_coarse_triangles(void)
{
    sb_vec3 corners[4] = {{1, 0, 0}, {1, 1, 0}, {1, 1, 1}, {1, 0, 1}};
    int faces[6] = {0, 1, 2, 0, 2, 3}, last = 1;
    sb_mesh square;
    solid s = make_box(sb_v3(0, 0, 0), sb_v3(1, 1, 1));
    sb_grid_def def = make_def(&s, sb_v3(0, 0, 0), sb_v3(1, 1, 1), 5, 5, 5);
    sb_grid grid = make_grid(&def);
    sb_grid_rows rows;
    sb_vec3 *forces = (sb_vec3 *)calloc((size_t)grid.mesh.node_count, sizeof(sb_vec3)), traction = sb_v3(2, 0, 0);
    memset(&square, 0, sizeof square);
    square.node_count = 4;
    square.nodes = corners;
    square.element_type = SB_TRI3;
    square.element_count = 2;
    square.elements = faces;
    CHECK_OK(sb_grid_map_surface(&grid, &square, NULL, 0, NULL, &rows, NULL));
    CHECK_INT(rows.rows.row_count, 2 * 3 * 64); /* sqrt 2 long, cells of 0.2: cut into 8 along each edge */
    sb_grid_add_traction(&rows, &traction, 1, forces);
    for (int i = 0; i < grid.mesh.node_count; i++) {
        sb_vec3 x = grid.mesh.nodes[i];
        int rims = ((double)x.y < 0.01 || (double)x.y > 0.99) + ((double)x.z < 0.01 || (double)x.z > 0.99);
        double expected = (double)x.x < 0.99 ? 0 : 2 * 0.04 * (rims == 0 ? 1 : rims == 1 ? 0.5 : 0.25);
        CHECK_NEAR(forces[i].x, expected, 0.05 * 0.08); /* pieces do not end where cells do */
    }
    sb_grid_rows_free(&rows);
    CHECK_OK(sb_grid_map_surface(&grid, &square, &last, 1, NULL, &rows, NULL));
    CHECK_INT(rows.rows.row_count, 3 * 64);
    CHECK((double)rows.points[0].z > (double)rows.points[0].y);
    sb_grid_rows_free(&rows);
    free(forces);
    sb_grid_free(&grid);
}

/* ---- cylinders: section 4.8 of the thesis ---- */

enum { DISC_RINGS = 8, DISC_SECTORS = 48 };

/* A disc at height z, normal along +z. */
static sb_mesh make_disc(double radius, double z)
{
    sb_mesh mesh;
    int count = 1, triangles = 0;
    memset(&mesh, 0, sizeof mesh);
    mesh.element_type = SB_TRI3;
    mesh.nodes = (sb_vec3 *)malloc((1 + DISC_RINGS * DISC_SECTORS) * sizeof(sb_vec3));
    mesh.elements = (int *)malloc(2 * DISC_RINGS * DISC_SECTORS * 3 * sizeof(int));
    mesh.nodes[0] = sb_v3(0, 0, REAL(z));
    for (int r = 1; r <= DISC_RINGS; r++)
        for (int s = 0; s < DISC_SECTORS; s++) {
            double angle = 2 * pi * s / (int)DISC_SECTORS, reach = radius * r / (int)DISC_RINGS;
            int next = (s + 1) % DISC_SECTORS, base = 1 + (r - 1) * DISC_SECTORS, before = base - DISC_SECTORS;
            int *t = mesh.elements + 3 * triangles;
            mesh.nodes[count++] = sb_v3(REAL(reach * cos(angle)), REAL(reach * sin(angle)), REAL(z));
            t[0] = r > 1 ? before + s : 0;
            t[1] = base + s;
            t[2] = base + next;
            triangles++;
            if (r > 1) {
                t[3] = before + s;
                t[4] = base + next;
                t[5] = before + next;
                triangles++;
            }
        }
    mesh.node_count = count;
    mesh.element_count = triangles;
    return mesh;
}

/* Points to compare displacements at: a reference's nodes, or a net in the cylinder. */
typedef struct probes {
    int count;
    sb_vec3 *x, *u; /* u: the reference's displacements, or NULL */
} probes;

static probes net_probes(double radius, double length)
{
    probes p = {0, NULL, NULL};
    p.x = (sb_vec3 *)malloc(21 * 9 * sizeof(sb_vec3));
    for (int k = 0; k <= 20; k++)
        for (int i = 0; i < 9; i++) {
            double angle = 2 * pi * i / 8, reach = i == 8 ? 0 : 0.9 * radius;
            p.x[p.count++] = sb_v3(REAL(reach * cos(angle)), REAL(reach * sin(angle)), REAL(length * k / 20));
        }
    return p;
}

/* The nodes and displacements of a reference case; no count when it is not there. */
static probes reference_probes(const char *name)
{
    probes p = {0, NULL, NULL};
    char path[512], relative[256], line[256];
    sb_mesh mesh;
    FILE *file;
    snprintf(relative, sizeof relative, "reference/%s/solution.txt", name);
    if (!check_shared_path(path, sizeof path, relative))
        return p;
    file = fopen(path, "r");
    memset(&mesh, 0, sizeof mesh);
    snprintf(relative, sizeof relative, "reference/%s/mesh.vtk", name);
    check_shared_path(path, sizeof path, relative);
    if (!CHECK_OK(sb_mesh_load(&mesh, path, NULL, NULL)) || !CHECK(file != NULL))
        return p;
    p.x = mesh.nodes; /* taken over: freed like net_probes's */
    p.u = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof(sb_vec3));
    while (fgets(line, sizeof line, file)) {
        int node;
        double u[3];
        if (line[0] != '#' && sscanf(line, "%d %lf %lf %lf", &node, &u[0], &u[1], &u[2]) == 4 && node >= 0 &&
            node < mesh.node_count)
            p.u[node] = sb_v3(REAL(u[0]), REAL(u[1]), REAL(u[2])), p.count++;
    }
    fclose(file);
    CHECK_INT(p.count, mesh.node_count);
    mesh.nodes = NULL;
    sb_mesh_free(&mesh);
    return p;
}

static void free_probes(probes *p)
{
    free(p->x);
    free(p->u);
}

typedef struct study {
    int stretch;   /* 0: bent */
    int across;    /* cells over the diameter */
    double offset; /* of the grid across, in cells; > 0: a cell more, so that all cuts move */
    sb_grid_method method;
    int level;
    double void_stiffness;
    int penalty; /* 1: clamped through penalty rows on the base */
} study;

static double study_length(const study *s) { return s->stretch ? 0.05 : 0.6; }

static sb_grid study_grid(const study *s)
{
    solid c = make_cylinder(0.05, study_length(s));
    double edge = 0.1 / s->across, shift = s->offset * edge, more = s->offset > 0 ? edge : 0;
    sb_grid_def def =
        make_def(&c, sb_v3(REAL(-0.05 - shift), REAL(-0.05 - shift), 0),
                 sb_v3(REAL(0.05 - shift + more), REAL(0.05 - shift + more), REAL(study_length(s))),
                 s->across + (s->offset > 0), s->across + (s->offset > 0), (int)(study_length(s) / edge + 0.5));
    def.method = s->method;
    def.level = s->level;
    def.void_stiffness = REAL(s->void_stiffness);
    def.max_points = 2000000;
    return make_grid(&def);
}

/* Pulls the base to where it is, with a stiffness that grows with the area. */
static void clamp_by_penalty(sb_body *body, const sb_grid *grid)
{
    sb_mesh disc = make_disc(0.05, 0);
    sb_grid_rows rows;
    sb_real *stiffness;
    sb_vec3 *targets;
    if (CHECK_OK(sb_grid_map_surface(grid, &disc, NULL, 0, NULL, &rows, NULL))) {
        stiffness = (sb_real *)malloc((size_t)rows.rows.row_count * sizeof(sb_real));
        targets = (sb_vec3 *)malloc((size_t)rows.rows.row_count * sizeof(sb_vec3));
        for (int j = 0; j < rows.rows.row_count; j++) {
            stiffness[j] = REAL(100 * 5000 / (double)grid->cell_size.x) * rows.areas[j];
            targets[j] = rows.points[j];
        }
        CHECK_OK(sb_body_add_mapping(body, &rows.rows, stiffness, 0, targets, NULL, NULL));
        free(stiffness);
        free(targets);
        sb_grid_rows_free(&rows);
    }
    free(disc.nodes);
    free(disc.elements);
}

static void load_study(const study *s, const sb_grid *grid, sb_body *body)
{
    sb_vec3 *forces = (sb_vec3 *)calloc((size_t)grid->mesh.node_count, sizeof(sb_vec3)), up = sb_v3(0, 0, REAL(0.1)),
            down = sb_v3(0, REAL(-30), 0);
    sb_mesh disc = make_disc(0.05, 0.6);
    sb_grid_rows rows;
    if (s->penalty)
        clamp_by_penalty(body, grid);
    else
        scene_fix_plane(body, &grid->body_mesh, 2, 0, SB_XYZ);
    for (int i = 0; i < grid->mesh.node_count && s->stretch; i++)
        if ((double)grid->mesh.nodes[i].z > 0.05 - 1e-6)
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &up, 1));
    if (!s->stretch && CHECK_OK(sb_grid_map_surface(grid, &disc, NULL, 0, NULL, &rows, NULL))) {
        sb_grid_add_traction(&rows, &down, 1, forces);
        for (int i = 0; i < grid->mesh.node_count; i++)
            CHECK_OK(sb_body_add_forces(body, &i, 1, forces + i, 1));
        sb_grid_rows_free(&rows);
    }
    free(forces);
    free(disc.nodes);
    free(disc.elements);
}

/* Solves a study and returns the displacements at the probes (to be freed). info may be NULL. */
static sb_vec3 *solve_study(const study *s, const probes *p, sb_step_info *info)
{
    sb_grid grid = study_grid(s);
    sb_body_def def =
        grid_body_def(&grid, sb_material_neo_hookean_isochoric(REAL(961.5384615384615), REAL(0.00048), REAL(1000)));
    sb_body *body = scene_body(&def);
    sb_static_options options = sb_default_static_options();
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)p->count, sizeof(sb_vec3));
    sb_grid_rows rows;
    sb_step_info own;
    load_study(s, &grid, body);
    options.tolerance = REAL(scene_tolerance(1e-6, 300));
    if (!CHECK_OK(sb_body_solve_static(body, &options, info ? info : &own)))
        printf("    method %d, level %d, %d across: %s\n", (int)s->method, s->level, s->across,
               (info ? info : &own)->error.message);
    if (CHECK_OK(sb_grid_map_points(&grid, p->x, p->count, NULL, &rows, NULL)))
        sb_mapping_apply(&rows.rows, sb_body_displacements(body), u);
    sb_grid_rows_free(&rows);
    sb_body_destroy(body);
    sb_grid_free(&grid);
    return u;
}

/* |a - b| / |b| over the probes. */
static double difference(const sb_vec3 *a, const sb_vec3 *b, int count)
{
    double sum = 0, size = 0;
    for (int i = 0; i < count; i++) {
        sb_vec3 d = sb_v3_sub(a[i], b[i]);
        sum += (double)sb_v3_dot(d, d);
        size += (double)sb_v3_dot(b[i], b[i]);
    }
    return sqrt(sum / size);
}

static study make_study(int stretch, int across, double offset, sb_grid_method method, int level)
{
    study s;
    memset(&s, 0, sizeof s);
    s.stretch = stretch;
    s.across = across;
    s.offset = offset;
    s.method = method;
    s.level = level;
    s.void_stiffness = 1e-4;
    return s;
}

/* The weighted cell stays within 5 % of the finite cell, at every level, in both studies. */
static void test_weighted_follows_finite_cell(void)
{
    int slow = getenv("CHECK_SLOW") != NULL;
    for (int stretch = 0; stretch < 2; stretch++)
        for (int level = 1; level <= (slow ? 3 : 2); level++)
            for (int shifted = 0; shifted < 2; shifted++) {
                study s = make_study(stretch, stretch ? 6 : slow ? 4 : 3, 0.37 * shifted, SB_GRID_FINITE_CELL, level);
                probes net;
                sb_vec3 *fc, *wc;
                double apart;
                if (!slow && level == 2 && shifted)
                    continue;
                net = net_probes(0.05, study_length(&s));
                fc = solve_study(&s, &net, NULL);
                s.method = SB_GRID_WEIGHTED_CELL;
                wc = solve_study(&s, &net, NULL);
                apart = difference(wc, fc, net.count);
                printf("%s, level %d, grid %s: weighted cell %.2f %% from finite cell\n", stretch ? "stretch" : "bend",
                       level, shifted ? "shifted" : "centred", 100 * apart);
                CHECK(apart < 0.05);
                free(fc);
                free(wc);
                free_probes(&net);
            }
}

/* Finer grids come closer to the reference, with both methods. */
static void test_convergence_to_reference(void)
{
    static const char *const names[2] = {"cylinder_bend_fine_tet10", "cylinder_stretch3_tet10"};
    static const int across[2][3] = {{2, 4, 6}, {4, 8, 12}};
    int slow = getenv("CHECK_SLOW") != NULL;
    for (int stretch = 0; stretch < 2; stretch++) {
        probes p = reference_probes(names[stretch]);
        if (p.count == 0) {
            CHECK_SKIP("no ../shared/reference");
            continue;
        }
        for (int method = SB_GRID_FINITE_CELL; method <= SB_GRID_WEIGHTED_CELL; method++) {
            double before = 1;
            int most = slow ? 3 : method == SB_GRID_FINITE_CELL ? 1 + stretch : 2 + !stretch;
            for (int k = 0; k < most; k++) {
                study s = make_study(stretch, across[stretch][k], 0, (sb_grid_method)method,
                                     method == SB_GRID_FINITE_CELL ? 2 - (stretch && !slow) : 3);
                sb_vec3 *u = solve_study(&s, &p, NULL);
                double error = difference(u, p.u, p.count);
                printf("%s, %s, %d across: %.2f %% from the reference\n", stretch ? "stretch" : "bend",
                       method == SB_GRID_FINITE_CELL ? "finite cell" : "weighted cell", s.across, 100 * error);
                CHECK(k == 0 ? error < 0.25 : error < 0.65 * before);
                before = error;
                free(u);
            }
            CHECK(before < (most == 3 ? 0.025 : most == 2 ? 0.04 : 0.25));
        }
        free_probes(&p);
    }
}

/* Three times its length at every level, however the grid cuts, no cell removed. */
static void test_stretch_survives(void)
{
    for (int level = 0; level <= 5; level++)
        for (int shift = 0; shift < 3; shift++) {
            study s = make_study(1, 6, 0.34 * shift, SB_GRID_WEIGHTED_CELL, level);
            probes net = net_probes(0.05, 0.05);
            sb_step_info info;
            sb_vec3 *u = solve_study(&s, &net, &info), *plain;
            CHECK_NEAR(info.load_factor, 1, 0);
            CHECK_NEAR(u[net.count - 1].z, 0.1, 1e-3 * 0.1);
            CHECK_NEAR(u[10 * 9 + 8].z, 0.05, 0.01 * 0.05); /* the middle of it */
            if (level == 3 && shift == 1) {                 /* what holds the void is no part of the answer */
                s.void_stiffness = 1e-6;
                plain = solve_study(&s, &net, NULL);
                CHECK(difference(u, plain, net.count) < 1e-3);
                free(plain);
            }
            free(u);
            free_probes(&net);
        }
}

/* A base held by penalty rows is as good as one held by its nodes. */
static void test_penalty_clamp(void)
{
    study s = make_study(0, 3, 0, SB_GRID_WEIGHTED_CELL, 2);
    probes net = net_probes(0.05, 0.6);
    sb_vec3 *held = solve_study(&s, &net, NULL), *pulled;
    double apart;
    s.penalty = 1;
    pulled = solve_study(&s, &net, NULL);
    apart = difference(pulled, held, net.count);
    printf("clamp by penalty: %.2f %% from clamped nodes\n", 100 * apart);
    CHECK(apart < 0.02 && apart > 0);
    free(held);
    free(pulled);
    free_probes(&net);
}

/* ---- badly cut cells and conjugate gradients: figure 4.10 ---- */

/* Grid of a block that reaches `shift` cells into the cells beyond those that it fills. */
static sb_grid shifted_block(double shift, double void_stiffness)
{
    solid block = make_box(sb_v3(0, 0, 0), sb_v3(REAL(3 + shift), REAL(3 + shift), REAL(6 + shift)));
    int extra = shift > 0;
    sb_grid_def def = make_def(&block, sb_v3(0, 0, 0), sb_v3(REAL(3 + extra), REAL(3 + extra), REAL(6 + extra)),
                               3 + extra, 3 + extra, 6 + extra);
    def.level = shift > 0 ? 6 : 1;
    def.void_stiffness = REAL(void_stiffness);
    return make_grid(&def);
}

/* Iterations of a solve of the block under its weight, held at its base; *answer: how far its top sags. */
static int count_iterations(const sb_grid *grid, sb_precond_kind kind, double *answer)
{
    sb_body_def def = grid_body_def(grid, sb_material_linear(REAL(5000), REAL(0.3), REAL(1)));
    sb_body *body;
    sb_step_info info;
    sb_static_options options = sb_default_static_options();
    sb_vec3 top = sb_v3(REAL(1.5), REAL(1.5), 6), moved = top;
    sb_grid_rows rows;
    def.preconditioner = kind;
    def.gravity = sb_v3(0, -1, 0);
    body = scene_body(&def);
    scene_fix_plane(body, &grid->body_mesh, 2, 0, SB_XYZ);
    options.tolerance = REAL(scene_tolerance(1e-8, 300));
    CHECK_OK(sb_body_solve_static(body, &options, &info));
    CHECK_OK(sb_grid_map_points(grid, &top, 1, NULL, &rows, NULL));
    sb_mapping_apply(&rows.rows, sb_body_displacements(body), &moved);
    *answer = (double)moved.y;
    sb_grid_rows_free(&rows);
    sb_body_destroy(body);
    return info.pcg_iterations;
}

static void test_cut_cells_and_iterations(void)
{
    static const double shifts[6] = {0, 0.5, 0.1, 0.03, 0.01, 0.01};
    static const sb_precond_kind kinds[3] = {SB_PRECOND_BLOCK_JACOBI, SB_PRECOND_AUTO, SB_PRECOND_NONE};
    int uncut[3] = {0, 0, 0};
    double whole = 0;
    for (int i = 0; i < 6; i++) {
        double least = 1, answer = 0, hold = i == 5 ? 1e-8 : 1e-4;
        sb_grid grid = shifted_block(shifts[i], hold);
        int iterations[3] = {0, 0, 0};
        for (int e = 0; e < grid.mesh.element_count; e++)
            least = fmin(least, (double)grid.shares[e]);
        for (int k = 0; k < (i == 0 || i == 4 ? 3 : 2); k++) {
            iterations[k] = count_iterations(&grid, kinds[k], &answer);
            if (i == 0)
                uncut[k] = iterations[k];
            if (k < 2)
                CHECK(iterations[k] <= uncut[k] + uncut[k] / 2 + 5);
        }
        printf("smallest share of a cell %.1e, void %g: %d iterations with block Jacobi, %d by default", least, hold,
               iterations[0], iterations[1]);
        printf(iterations[2] ? ", %d without\n" : "\n", iterations[2]);
        if (i == 0)
            whole = answer;
        if (i >= 4) {
            CHECK(least < 1e-6);
            CHECK_NEAR(answer, whole, 0.03 * fabs(whole)); /* a hundredth of a cell makes little difference */
        }
        if (i == 4 && !SB_REAL_IS_FLOAT)
            CHECK(iterations[2] > 3 * uncut[2]); /* what a diagonal spares */
        sb_grid_free(&grid);
    }
}

/* ---- dynamics ---- */

/* A free body on a grid falls like any other: weight and momentum are those of its volume. */
static void test_free_fall(void)
{
    solid s = make_ball(sb_v3(REAL(0.001), REAL(0.002), 0), 0.05);
    sb_grid_def def = make_def(&s, sb_v3(REAL(-0.05), REAL(-0.05), REAL(-0.05)),
                               sb_v3(REAL(0.055), REAL(0.055), REAL(0.055)), 5, 5, 5);
    for (int kind = SB_MASS_LUMPED; kind <= SB_MASS_CONSISTENT; kind++) {
        sb_grid grid = make_grid(&def);
        sb_body_def body_def = grid_body_def(&grid, sb_material_corotated(REAL(5000), REAL(0.4), REAL(1000)));
        sb_body *body;
        double mass = 1000 * (double)grid.volume, v;
        body_def.mass = (sb_mass_kind)kind;
        body_def.integrator = SB_NEWMARK;
        body_def.tolerance = REAL(1e-9);
        body_def.gravity = sb_v3(0, 0, REAL(-9.81));
        body = scene_body(&body_def);
        CHECK_NEAR(sb_body_mass(body), mass, scene_tolerance(1e-12, 100) * mass);
        for (int k = 0; k < 10; k++)
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        v = (double)sb_body_momentum(body).z / mass;
        CHECK_NEAR(v, -0.981, scene_tolerance(1e-6, 1e4));
        for (int i = 0; i < grid.mesh.node_count; i++)
            CHECK_NEAR(sb_body_velocities(body)[i].z, -0.981,
                       kind == SB_MASS_CONSISTENT ? scene_tolerance(1e-5, 1e5) : 0.05);
        sb_body_destroy(body);
        sb_grid_free(&grid);
    }
}

/* ---- failures ---- */

static sb_real bad_distance(void *user, sb_vec3 point)
{
    (void)user;
    return point.x > REAL(0.02) ? (sb_real)NAN : sb_v3_norm(point) - REAL(0.05);
}

static void test_errors(void)
{
    solid s = make_ball(sb_v3(0, 0, 0), 0.05);
    sb_vec3 low = sb_v3(REAL(-0.05), REAL(-0.05), REAL(-0.05)), high = sb_v3(REAL(0.05), REAL(0.05), REAL(0.05));
    sb_grid_def good = make_def(&s, low, high, 4, 4, 4), def;
    sb_shape inner = make_shape(&s, -2);
    sb_grid grid;
    sb_grid_rows rows;
    sb_error error;
    sb_vec3 points[2] = {{0, 0, 0}, {REAL(0.2), 0, 0}};
    int triangle[3] = {0, 1, 0}, index = 5;
    sb_mesh surface;
    def = good;
    def.cookie = 0;
    CHECK_RESULT(refused(&def, "sb_default_grid_def"), SB_ERROR_ARGUMENT);
    def = good;
    def.method = (sb_grid_method)0;
    CHECK_RESULT(refused(&def, "def.method 0"), SB_ERROR_ARGUMENT);
    def = good;
    def.level = 9;
    CHECK_RESULT(refused(&def, "def.level 9"), SB_ERROR_ARGUMENT);
    def = good;
    def.outer.distance = NULL;
    CHECK_RESULT(refused(&def, "def.outer needs a surface or a distance"), SB_ERROR_ARGUMENT);
    def = good;
    def.outer.region = SB_GRID_EMPTY;
    CHECK_RESULT(refused(&def, "def.outer.region -1"), SB_ERROR_ARGUMENT);
    def = good;
    def.inner = &inner;
    def.inner_count = 1;
    CHECK_RESULT(refused(&def, "def.inner[00].region -2"), SB_ERROR_ARGUMENT);
    def.inner_count = SB_GRID_MAX_SHAPES;
    CHECK_RESULT(refused(&def, "def.inner_count 30"), SB_ERROR_ARGUMENT);
    def.inner = NULL;
    def.inner_count = 1;
    CHECK_RESULT(refused(&def, "def.inner is NULL"), SB_ERROR_ARGUMENT);
    def = good;
    def.void_stiffness = 1;
    CHECK_RESULT(refused(&def, "def.void_stiffness 1"), SB_ERROR_ARGUMENT);
    def.void_stiffness = (sb_real)NAN;
    check_bad_numbers();
    CHECK_RESULT(refused(&def, "def.void_stiffness"), SB_ERROR_ARGUMENT);
    def = good;
    def.least_share = -1;
    CHECK_RESULT(refused(&def, "def.least_share -1"), SB_ERROR_ARGUMENT);
    def = good;
    def.max_points = 0;
    CHECK_RESULT(refused(&def, "def.max_points 0"), SB_ERROR_ARGUMENT);
    def = good;
    def.low.y = (sb_real)INFINITY;
    CHECK_RESULT(refused(&def, "not finite"), SB_ERROR_NOT_FINITE);
    def = good;
    def.high.y = def.low.y;
    CHECK_RESULT(refused(&def, "has no volume"), SB_ERROR_ARGUMENT);
    def = good;
    def.low = def.high;
    CHECK_RESULT(refused(&def, "has no bounds"), SB_ERROR_ARGUMENT);
    def = good;
    def.counts[1] = 0;
    CHECK_RESULT(refused(&def, "def.counts 4 0 4"), SB_ERROR_ARGUMENT);
    def.counts[0] = def.counts[2] = 0;
    def.cells = 0;
    CHECK_RESULT(refused(&def, "def.cells 0"), SB_ERROR_ARGUMENT);
    def.cells = 4;
    def.cell_size = REAL(-1);
    CHECK_RESULT(refused(&def, "def.cell_size -1"), SB_ERROR_ARGUMENT);
    def.cell_size = REAL(INFINITY);
    CHECK_RESULT(refused(&def, "def.cell_size"), SB_ERROR_NOT_FINITE);
    def.cell_size = REAL(1e-6);
    CHECK_RESULT(refused(&def, "too large"), SB_ERROR_UNSUPPORTED);
    def = good;
    def.counts[0] = INT32_MAX;
    CHECK_RESULT(refused(&def, "too large"), SB_ERROR_UNSUPPORTED);
    def = good;
    def.method = SB_GRID_FINITE_CELL;
    def.max_points = 1000;
    CHECK_RESULT(refused(&def, "more than 1000 points at level 3"), SB_ERROR_UNSUPPORTED);
    def = good;
    def.outer.distance = bad_distance;
    CHECK_RESULT(refused(&def, "distance in cell"), SB_ERROR_NOT_FINITE);
    def = good;
    def.progress = stop_progress;
    CHECK_RESULT(refused(&def, "stopped by the progress callback"), SB_ERROR_CANCELLED);
    def = good;
    def.outer.max_slope = -1;
    CHECK_RESULT(refused(&def, "def.outer.max_slope -1"), SB_ERROR_ARGUMENT);
    def = good;
    s.centre.x = 10;
    CHECK_RESULT(refused(&def, "no cell"), SB_ERROR_MESH);
    s.centre.x = 0;
    CHECK_RESULT(sb_grid_create(NULL, &grid, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_grid_create(&def, NULL, NULL), SB_ERROR_ARGUMENT);

    grid = make_grid(&good);
    memset(&rows, 0x55, sizeof rows);
    CHECK_RESULT(sb_grid_map_points(&grid, points, 2, NULL, &rows, &error), SB_ERROR_ARGUMENT);
    CHECK_INT(error.node, 1);
    CHECK(strstr(error.message, "more than a cell away") != NULL);
    points[1].x = (sb_real)NAN;
    CHECK_RESULT(sb_grid_map_points(&grid, points, 2, NULL, &rows, &error), SB_ERROR_NOT_FINITE);
    points[1].x = SB_REAL_MAX;
    CHECK_RESULT(sb_grid_map_points(&grid, points, 2, NULL, &rows, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_grid_map_points(NULL, points, 1, NULL, &rows, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_grid_map_points(&grid, points, 0, NULL, &rows, &error), SB_ERROR_ARGUMENT);
    memset(&surface, 0, sizeof surface);
    surface.element_type = SB_TRI3;
    surface.node_count = 2;
    surface.nodes = points;
    surface.element_count = 1;
    surface.elements = triangle;
    points[1] = sb_v3(REAL(0.01), 0, 0);
    CHECK_RESULT(sb_grid_map_surface(&grid, &surface, NULL, 0, NULL, &rows, &error), SB_ERROR_MESH);
    CHECK_INT(error.element, 0);
    CHECK_RESULT(sb_grid_map_surface(&grid, &surface, &index, 1, NULL, &rows, &error), SB_ERROR_INDEX);
    CHECK_RESULT(sb_grid_map_surface(&grid, &surface, &index, 0, NULL, &rows, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_grid_map_surface(&grid, &grid.mesh, NULL, 0, NULL, &rows, &error), SB_ERROR_ARGUMENT);
    points[1].x = 1000;
    CHECK_RESULT(sb_grid_map_surface(&grid, &surface, NULL, 0, NULL, &rows, &error), SB_ERROR_UNSUPPORTED);
    CHECK(rows.rows.row_count == 0x55555555);
    sb_grid_free(&grid);
    sb_grid_free(&grid);
    sb_grid_free(NULL);
    sb_grid_rows_free(NULL);
}

static void test_allocation_failures(void)
{
    solid s = make_ball(sb_v3(0, 0, 0), 0.05);
    for (int method = SB_GRID_FINITE_CELL; method <= SB_GRID_WEIGHTED_CELL; method++) {
        scene_memory memory = {0, 0, 0, 0};
        sb_allocator allocator = scene_allocator(&memory);
        sb_grid_def def = make_def(&s, sb_v3(REAL(-0.05), REAL(-0.05), REAL(-0.05)),
                                   sb_v3(REAL(0.05), REAL(0.05), REAL(0.05)), 3, 3, 3);
        sb_vec3 point = sb_v3(0, 0, 0);
        sb_grid grid;
        sb_grid_rows rows;
        sb_result result = SB_ERROR_MEMORY;
        int at = 0;
        def.method = (sb_grid_method)method;
        def.level = 1;
        def.allocator = allocator;
        memset(&grid, 0, sizeof grid);
        while (result == SB_ERROR_MEMORY && at < 100) {
            memory.calls = 0;
            memory.fail_at = ++at;
            result = sb_grid_create(&def, &grid, NULL);
            CHECK(result == SB_OK || (memory.live == 0 && grid.mesh.nodes == NULL));
        }
        CHECK_OK(result);
        CHECK(at > 15);
        memory.calls = 0;
        memory.fail_at = 1;
        CHECK_RESULT(sb_grid_map_points(&grid, &point, 1, &allocator, &rows, NULL), SB_ERROR_MEMORY);
        CHECK_OK(sb_grid_map_points(&grid, &point, 1, &allocator, &rows, NULL));
        sb_grid_rows_free(&rows);
        sb_grid_free(&grid);
        CHECK_INT(memory.live, 0);
    }
}

CHECK_SUITE(grid, {"volumes and moments by level", test_volumes},
            {"explicit steps of cut cells", test_explicit_steps_of_cut_cells},
            {"cells and points do not depend on the level", test_cells_do_not_depend_on_level},
            {"a block that fills its cells", test_aligned_block_is_plain_mesh},
            {"a surface that crosses itself", test_crossing_surface}, {"unknown slope", test_unknown_slope},
            {"surfaces, threads and progress", test_surfaces_and_jobs}, {"a surface with a hole", test_open_surface},
            {"a surface inside out", test_inside_out}, {"scale", test_scale}, {"regions and holes", test_regions},
            {"bars of two materials", test_two_materials}, {"rows of points and tractions", test_rows},
            {"triangles larger than cells", test_coarse_triangles},
            {"weighted cells follow finite cells", test_weighted_follows_finite_cell},
            {"convergence to the reference", test_convergence_to_reference},
            {"stretched to three times its length", test_stretch_survives}, {"clamp by penalty", test_penalty_clamp},
            {"badly cut cells do not ruin conjugate gradients", test_cut_cells_and_iterations},
            {"free fall", test_free_fall}, {"bad arguments", test_errors},
            {"allocation failures", test_allocation_failures});
