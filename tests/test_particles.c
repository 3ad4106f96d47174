/* particles: kernels, moving least squares, consistent gradients, and clouds as elements of meshes. Bodies made of them
 * are in test_particles_body.c. */
#include "softbody.h"

#include "check.h"
#include "particle_scene.h"

static const sb_kernel kernels[5] = {SB_KERNEL_SPIKY, SB_KERNEL_POLY6, SB_KERNEL_COSINE, SB_KERNEL_CUBIC,
                                     SB_KERNEL_QUARTIC};

/* ---- kernels ---- */

static void test_kernels(void)
{
    const double h = 0.7, pi = 3.14159265358979323846;
    for (int k = 0; k < 5; k++) {
        const int pieces = 4000;
        double sum = 0;
        for (int i = 0; i < pieces; i++) { /* Simpson, whose pieces meet the spline's knot */
            double a = h * i / pieces, b = h * (i + 1) / pieces, m = (a + b) / 2;
            sum += (b - a) / 6 * 4 * pi *
                   (a * a * (double)sb_kernel_value(kernels[k], REAL(a), REAL(h)) +
                    4 * m * m * (double)sb_kernel_value(kernels[k], REAL(m), REAL(h)) +
                    b * b * (double)sb_kernel_value(kernels[k], REAL(b), REAL(h)));
        }
        CHECK_NEAR(sum, 1, scene_tolerance(1e-9, 20));
        for (int i = 1; i < 40; i++) {
            double r = h * (i + 0.3) / 40, e = SB_REAL_IS_FLOAT ? 2e-3 : 1e-5;
            double up = (double)sb_kernel_value(kernels[k], REAL(r + e), REAL(h));
            double down = (double)sb_kernel_value(kernels[k], REAL(r - e), REAL(h));
            CHECK_NEAR(sb_kernel_slope(kernels[k], REAL(r), REAL(h)), (up - down) / (2 * e),
                       SB_REAL_IS_FLOAT ? 0.05 : 2e-7);
        }
        CHECK(sb_kernel_value(kernels[k], REAL(h), REAL(h)) == 0);
        CHECK(sb_kernel_slope(kernels[k], REAL(2 * h), REAL(h)) == 0);
        CHECK(sb_kernel_value(kernels[k], REAL(-0.1), REAL(h)) == 0);
    }
    CHECK(sb_kernel_value((sb_kernel)0, REAL(0.1), REAL(h)) == 0);
    CHECK(sb_kernel_slope((sb_kernel)9, REAL(0.1), REAL(h)) == 0);
}

/* ---- completeness ---- */

/* What a random quadratic field is at x, and its gradient. */
typedef struct field {
    double c, g[3], h[3][3]; /* h symmetric; zeros: linear */
    sb_vec3 origin;
    double scale; /* m */
} field;

static field random_field(unsigned long long *seed, sb_vec3 origin, double scale, int quadratic)
{
    field f;
    memset(&f, 0, sizeof f);
    f.origin = origin;
    f.scale = scale;
    f.c = check_random_in(seed, -1, 1);
    for (int i = 0; i < 3; i++)
        f.g[i] = check_random_in(seed, -1, 1);
    for (int i = 0; i < 3 && quadratic; i++)
        for (int j = 0; j <= i; j++)
            f.h[i][j] = f.h[j][i] = check_random_in(seed, -1, 1);
    return f;
}

static double field_at(const field *f, sb_vec3 x, double gradient[3])
{
    const double d[3] = {((double)x.x - (double)f->origin.x) / f->scale, ((double)x.y - (double)f->origin.y) / f->scale,
                         ((double)x.z - (double)f->origin.z) / f->scale};
    double value = f->c;
    for (int i = 0; i < 3; i++) {
        double slope = f->g[i];
        for (int j = 0; j < 3; j++) {
            slope += f->h[i][j] * d[j];
            value += 0.5 * f->h[i][j] * d[i] * d[j];
        }
        value += f->g[i] * d[i];
        gradient[i] = slope / f->scale;
    }
    return value;
}

/* Largest error of value and of gradient (times the spacing) over all points; the field is of the size of a spacing. */
static void worst_error(const sb_particles *p, unsigned long long *seed, int quadratic, double *value, double *slope)
{
    int n = p->domain.nodes_per_cell;
    *value = *slope = 0;
    for (int e = 0; e < p->mesh.element_count; e++) {
        field f = random_field(seed, p->points[e], (double)p->spacing, quadratic);
        double exact, gradient[3], sum = 0, sums[3] = {0, 0, 0}, ignored[3];
        exact = field_at(&f, p->points[e], gradient);
        for (int a = 0; a < n; a++) {
            size_t at = (size_t)e * (size_t)n + (size_t)a;
            double u = field_at(&f, p->mesh.nodes[p->domain.cells[at]], ignored);
            sum += (double)p->shapes[at] * u;
            for (int k = 0; k < 3; k++)
                sums[k] += (double)p->domain.gradients[3 * at + (size_t)k] * u;
        }
        *value = fmax(*value, fabs(sum - exact));
        for (int k = 0; k < 3; k++)
            *slope = fmax(*slope, (double)p->spacing * fabs(sums[k] - gradient[k]));
    }
}

/* Linear fields, and quadratic ones where there are ten monomials, are exact in any cloud, with any kernel, rule and
 * size, before and after gradients are made consistent. */
static void test_complete(void)
{
    static const int bases[4] = {4, 7, 10, 4};
    unsigned long long seed = 41;
    for (int round = 0; round < check_rounds(30); round++) {
        sb_particles_def def = sb_default_particles_def();
        double size = round % 3 == 0 ? 1e-3 : round % 3 == 1 ? 1 : 1e3, value, slope;
        particle_cloud cloud = random_cloud(&seed, 6, 5, 7, size, round % 5 == 0 ? 0 : 0.2);
        sb_particles p;
        def.kernel = kernels[round % 5];
        def.radius_rule = round % 7 == 3 ? SB_RADIUS_MEAN : SB_RADIUS_FARTHEST;
        def.dilatation = REAL(round % 7 == 3 ? 2.2 : 1.3 + 0.2 * (round % 4));
        def.method = round % 4 == 3 ? SB_PARTICLES_MLS : SB_PARTICLES_GRID;
        def.basis = bases[round % 4];
        def.neighbours = def.basis == 10 ? 27 : def.basis == 7 ? 18 : 10 + round % 9;
        def.points_per_cell = round % 2 ? 8 : 1;
        def.consistent = round % 8 < 6;
        cloud_use(&cloud, &def);
        p = make_particles(&def);
        CHECK(p.mesh.element_count > 100);
        worst_error(&p, &seed, def.basis == 10 && !def.consistent, &value, &slope);
        CHECK_NEAR(value, 0, def.method == SB_PARTICLES_MLS ? HUGE_VAL : scene_tolerance(1e-12, 5000));
        CHECK_NEAR(slope, 0, scene_tolerance(1e-11, 1e5));
        sb_particles_free(&p);
        cloud_free(&cloud);
    }
}

/* One monomial and SPH miss linear fields by tens of percent: that is why they are there for comparison only. */
static void test_incomplete(void)
{
    static const int neighbours[3] = {10, 20, 30};
    for (int k = 0; k < 3; k++) {
        unsigned long long seed = 5;
        sb_particles_def def = sb_default_particles_def();
        particle_cloud cloud = random_cloud(&seed, 8, 8, 8, 1, 0);
        double worst = 0, middle = 0;
        int centre = -1;
        sb_particles p;
        cloud_use(&cloud, &def);
        def.method = SB_PARTICLES_SPH;
        def.dilatation = 1;
        def.neighbours = neighbours[k];
        p = make_particles(&def);
        worst_error(&p, &seed, 0, &middle, &worst);
        for (int e = 0; e < p.mesh.element_count && centre < 0; e++)
            if (sb_v3_norm(sb_v3_sub(p.points[e], sb_v3(REAL(4.0 / 9), REAL(4.0 / 9), REAL(4.0 / 9)))) < p.spacing)
                centre = e;
        if (CHECK(centre >= 0)) { /* u = x: its slope, short of 1 by what SPH misses inside */
            const int *nodes = p.domain.cells + (size_t)centre * (size_t)p.domain.nodes_per_cell;
            const sb_real *g = p.domain.gradients + 3 * (size_t)centre * (size_t)p.domain.nodes_per_cell;
            double sum = 0;
            for (int a = 0; a < p.domain.nodes_per_cell; a++)
                sum += (double)g[3 * a] * (double)p.mesh.nodes[nodes[a]].x;
            printf("    SPH with %d neighbours: a slope of 1 comes out as %.2f\n", neighbours[k], sum);
            CHECK(fabs(sum - 1) > 0.2 && fabs(sum - 1) < 0.8);
        }
        CHECK(worst > 0.1);
        sb_particles_free(&p);
        cloud_free(&cloud);
    }
}

/* Gradients are the slopes of the shape functions: a fixed radius, so that these do not jump. */
static void test_slopes(void)
{
    unsigned long long seed = 77;
    const double step = SB_REAL_IS_FLOAT ? 2e-3 : 1e-5;
    for (int round = 0; round < 8; round++) {
        sb_particles_def def = sb_default_particles_def();
        particle_cloud cloud = random_cloud(&seed, 5, 5, 5, 1, 0.1);
        sb_particles p;
        double worst = 0;
        def.kernel = kernels[round % 5];
        def.basis = round % 2 ? 10 : 4;
        def.points_per_cell = 1;
        def.consistent = 0;
        cloud_use(&cloud, &def);
        def.radius_rule = SB_RADIUS_FIXED;
        def.radius = REAL(round % 2 ? 0.38 : 0.29);
        p = make_particles(&def);
        for (int e = 0; e < p.mesh.element_count; e += 7)
            for (int k = 0; k < 3; k++) {
                double slope[256] = {0};
                int n = p.domain.nodes_per_cell;
                for (int side = -1; side <= 1; side += 2) {
                    sb_vec3 at = p.points[e];
                    sb_grid_rows rows;
                    *(k == 0 ? &at.x : k == 1 ? &at.y : &at.z) += REAL(side * step);
                    if (!CHECK_OK(sb_particles_map_points(&p, &at, 1, NULL, &rows, NULL)))
                        continue;
                    for (int a = 0; a < rows.rows.row_start[1]; a++)
                        slope[rows.rows.nodes[a]] += side * (double)rows.rows.weights[a] / (2 * step);
                    sb_grid_rows_free(&rows);
                }
                for (int a = 0; a < n; a++) {
                    size_t at = (size_t)e * (size_t)n + (size_t)a;
                    if (a > 0 && p.domain.cells[at] == p.domain.cells[at - 1])
                        break;
                    worst =
                        fmax(worst, fabs(slope[p.domain.cells[at]] - (double)p.domain.gradients[3 * at + (size_t)k]));
                }
            }
        CHECK_NEAR(worst * (double)p.spacing, 0, SB_REAL_IS_FLOAT ? 0.02 : 1e-6);
        sb_particles_free(&p);
        cloud_free(&cloud);
    }
}

/* ---- volumes and balance ---- */

/* (3.12) finds too little volume; weights are scaled to what the body has. */
static void test_volumes(void)
{
    static const int neighbours[3] = {10, 20, 30};
    static const double low[3] = {0.7, 0.9, 1.0}, high[3] = {1.0, 1.2, 1.4};
    unsigned long long seed = 3;
    particle_cloud cloud = random_cloud(&seed, 9, 9, 9, 1, 0);
    for (int k = 0; k < 3; k++) {
        sb_particles_def def = sb_default_particles_def();
        double share;
        sb_particles p;
        def.method = SB_PARTICLES_SPH;
        def.dilatation = 1;
        def.neighbours = neighbours[k];
        def.points = cloud.points;
        def.point_count = cloud.count;
        p = make_particles(&def);
        share = (double)p.volume / (1000.0 / 729);
        printf("    (3.12) with %d neighbours: %.2f of the volume\n", neighbours[k], share);
        CHECK(share > low[k] && share < high[k]);
        sb_particles_free(&p);
        def.volume = REAL(0.5);
        p = make_particles(&def);
        CHECK_NEAR(p.volume, 0.5, scene_tolerance(1e-12, 100));
        sb_particles_free(&p);
        cloud_use(&cloud, &def);
        def.volume = 0;
        p = make_particles(&def);
        CHECK_NEAR(p.volume, 1, scene_tolerance(1e-9, 100));
        sb_particles_free(&p);
    }
    cloud_free(&cloud);
}

/* Largest |sum w g| / sum w |g| over inner particles as the domain has it. */
static double imbalance(const sb_particles *p, int *inner)
{
    int n = p->domain.nodes_per_cell;
    double(*sum)[4] = (double(*)[4])calloc((size_t)p->mesh.node_count, sizeof *sum), worst = 0;
    *inner = 0;
    for (int e = 0; e < p->mesh.element_count; e++)
        for (int a = 0; a < n; a++) {
            size_t at = (size_t)e * (size_t)n + (size_t)a;
            const sb_real *g = p->domain.gradients + 3 * at;
            double w = (double)p->domain.weights[e], size = 0;
            for (int k = 0; k < 3; k++) {
                sum[p->domain.cells[at]][k] += w * (double)g[k];
                size += (double)g[k] * (double)g[k];
            }
            sum[p->domain.cells[at]][3] += w * sqrt(size);
        }
    for (int i = 0; i < p->mesh.node_count; i++)
        if (p->inner[i] && sum[i][3] > 0) {
            worst =
                fmax(worst, sqrt(sum[i][0] * sum[i][0] + sum[i][1] * sum[i][1] + sum[i][2] * sum[i][2]) / sum[i][3]);
            ++*inner;
        }
    free(sum);
    return worst;
}

static void test_consistent(void)
{
    static const struct {
        sb_particle_method method;
        int basis, points, neighbours;
        double shake, low, high; /* of the imbalance before */
    } cases[7] = {{SB_PARTICLES_GRID, 4, 8, 10, 0, 0, 1e-4},     {SB_PARTICLES_GRID, 4, 1, 10, 0, 0, 1e-4},
                  {SB_PARTICLES_GRID, 10, 8, 27, 0, 0, 1e-4},    {SB_PARTICLES_MLS, 4, 1, 10, 0, 0, 0.01},
                  {SB_PARTICLES_GRID, 4, 8, 10, 0.2, 0.05, 0.5}, {SB_PARTICLES_GRID, 4, 1, 10, 0.2, 0.05, 0.5},
                  {SB_PARTICLES_MLS, 4, 1, 10, 0.2, 0.1, 0.9}};
    unsigned long long seed = 12;
    for (int k = 0; k < 7; k++) {
        sb_particles_def def = sb_default_particles_def();
        particle_cloud cloud = random_cloud(&seed, 9, 9, 9, 1, cases[k].shake);
        sb_particles p, plain;
        int inner = 0, same;
        size_t bytes;
        double left;
        def.method = cases[k].method;
        def.basis = cases[k].basis;
        def.points_per_cell = cases[k].points;
        def.neighbours = cases[k].neighbours;
        cloud_use(&cloud, &def);
        p = make_particles(&def);
        left = imbalance(&p, &inner);
        printf("    %s %d monomials, shaken by %.1f: imbalance %.2f %% -> %.1e of %d inner particles\n",
               def.method == SB_PARTICLES_MLS ? "MLS"
               : def.points_per_cell == 8     ? "8 points"
                                              : "1 point",
               def.basis, cases[k].shake, 100 * (double)p.imbalance, left, inner);
        CHECK(inner > 20);
        CHECK((double)p.imbalance >= cases[k].low && (double)p.imbalance < cases[k].high);
        CHECK_NEAR(left, 0, SB_REAL_IS_FLOAT ? 1e-5 : 1e-11);
        def.consistent = 0;
        plain = make_particles(&def);
        CHECK_NEAR(imbalance(&plain, &inner), plain.imbalance, scene_tolerance(1e-9, 100));
        /* what is in balance to rounding stays as it is */
        bytes = 3 * (size_t)p.domain.cell_count * (size_t)p.domain.nodes_per_cell * sizeof(sb_real);
        same = memcmp(p.domain.gradients, plain.domain.gradients, bytes) == 0;
        CHECK(same == (cases[k].low == 0 && cases[k].high < 0.001));
        sb_particles_free(&plain);
        sb_particles_free(&p);
        cloud_free(&cloud);
    }
}

/* ---- neighbours ---- */

/* Mirror images about the middle of a lattice have mirrored neighbours: ties are broken by groups, not by numbers. */
static void test_mirrors(void)
{
    for (int k = 4; k <= 26; k += 2 + k % 3)
        for (int method = 2; method <= 3; method++) {
            unsigned long long seed = 1;
            sb_particles_def def = sb_default_particles_def();
            particle_cloud cloud = random_cloud(&seed, 5, 4, 3, 1, 0);
            sb_particles p;
            int broken = 0, n;
            def.method = (sb_particle_method)method;
            def.points_per_cell = k % 2 ? 1 : 8;
            def.neighbours = method == 3 && k < 8 ? 8 : k;
            cloud_use(&cloud, &def);
            p = make_particles(&def);
            n = p.domain.nodes_per_cell;
            for (int e = 0; e < p.mesh.element_count; e++)
                for (int f = 0; f < p.mesh.element_count; f++) {
                    sb_vec3 m = p.points[f];
                    double sums[2] = {0, 0};
                    m.x = 1 - m.x;
                    if (sb_v3_norm(sb_v3_sub(m, p.points[e])) > REAL(1e-4))
                        continue;
                    for (int a = 0; a < n; a++) {
                        sb_vec3 x = p.mesh.nodes[p.domain.cells[e * n + a]],
                                y = p.mesh.nodes[p.domain.cells[f * n + a]];
                        sums[0] +=
                            (double)p.shapes[e * n + a] + pow((double)x.x - (double)p.points[e].x, 2) + (double)x.y;
                        sums[1] +=
                            (double)p.shapes[f * n + a] + pow((double)y.x - (double)p.points[f].x, 2) + (double)y.y;
                    }
                    broken += fabs(sums[0] - sums[1]) > 1e-3;
                }
            CHECK_INT(broken, 0);
            sb_particles_free(&p);
            cloud_free(&cloud);
        }
}

/* The nearest are those that a search through all finds. */
static void test_nearest(void)
{
    unsigned long long seed = 19;
    for (int round = 0; round < check_rounds(12); round++) {
        enum { COUNT = 300 };
        sb_vec3 points[COUNT];
        sb_particles_def def = sb_default_particles_def();
        sb_particles p;
        int wrong = 0;
        for (int i = 0; i < COUNT; i++) { /* crowded about the origin, in a thin slab, or even */
            double squeeze = round % 3 == 0 ? 0.01 + pow(check_random(&seed), 3) : 1;
            points[i] =
                sb_v3(REAL(squeeze * check_random_in(&seed, -1, 1)), REAL(squeeze * check_random_in(&seed, -1, 1)),
                      REAL(squeeze * check_random_in(&seed, -1, 1) * (round % 3 == 1 ? 0.05 : 1)));
        }
        def.method = SB_PARTICLES_MLS;
        def.neighbours = 5 + round;
        def.points = points;
        def.point_count = COUNT;
        p = make_particles(&def);
        for (int i = 0; i < COUNT && p.grown == 0; i++) {
            const int *nodes = p.domain.cells + (size_t)i * (size_t)p.domain.nodes_per_cell;
            double reach = 0;
            int nearer = 0;
            for (int a = 1; a < p.domain.nodes_per_cell; a++)
                reach = fmax(reach, (double)sb_v3_norm(sb_v3_sub(points[nodes[a]], points[i])));
            for (int j = 0; j < COUNT; j++)
                nearer += j != i && (double)sb_v3_norm(sb_v3_sub(points[j], points[i])) <= reach;
            wrong += nearer != def.neighbours;
        }
        CHECK_INT(wrong, 0);
        sb_particles_free(&p);
    }
}

/* ---- clouds as elements ---- */

static void test_clouds(void)
{
    unsigned long long seed = 2;
    sb_particles_def def = sb_default_particles_def();
    particle_cloud cloud = random_cloud(&seed, 3, 3, 3, 1, 0.1);
    sb_element_table bad;
    sb_mesh_report report;
    sb_index_table table;
    sb_boundary boundary;
    sb_domain domain;
    sb_particles p;
    sb_body_def body_def = sb_default_body_def();
    sb_body *body = NULL;
    sb_mesh copy;
    sb_error error;
    cloud_use(&cloud, &def);
    p = make_particles(&def);
    CHECK_OK(sb_element_table_check(p.table, NULL));
    CHECK_OK(sb_mesh_validate(&p.mesh, NULL));
    CHECK_OK(sb_mesh_copy(&p.mesh, NULL, &copy, NULL));
    sb_mesh_free(&copy);
    CHECK_RESULT(sb_mesh_check(&p.mesh, NULL, &report, &error), SB_ERROR_UNSUPPORTED);
    CHECK(strstr(error.message, "particles") != NULL);
    CHECK_RESULT(sb_mesh_boundary(&p.mesh, 1, NULL, &boundary, NULL), SB_ERROR_UNSUPPORTED);
    CHECK_RESULT(sb_mesh_neighbours(&p.mesh, NULL, &table, NULL), SB_ERROR_UNSUPPORTED);
    CHECK_RESULT(sb_mesh_edges(&p.mesh, NULL, &table, NULL), SB_ERROR_UNSUPPORTED);
    CHECK_RESULT(sb_domain_create(&p.mesh, SB_INTEGRATION_AUTO, 0, NULL, &domain, &error), SB_ERROR_UNSUPPORTED);
    CHECK_NEAR(sb_mesh_element_quality(&p.mesh, 0), 1, 0);
    CHECK_NEAR(sb_mesh_element_volume(&p.mesh, 0), 0, 0);
    body_def.mesh = &p.mesh;
    body_def.material = sb_material_corotated(1000, REAL(0.3), 1000);
    CHECK_RESULT(sb_body_create(&body_def, &body, &error), SB_ERROR_UNSUPPORTED);
    body_def.domain = &domain;
    domain = p.domain;
    domain.cell_mass = NULL;
    CHECK_RESULT(sb_body_create(&body_def, &body, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "cell_mass") != NULL);
    body_def.domain = &p.domain;
    CHECK_OK(sb_body_create(&body_def, &body, &error));
    if (body) {
        const int face[3] = {0, 1, 2};
        CHECK(sb_body_add_traction(body, face, 1, 3, sb_v3(0, 0, 1), &error) != SB_OK);
        CHECK_NEAR(sb_body_mass(body), 1000 * (double)p.volume, scene_tolerance(1e-9, 1000) * 1000);
        sb_body_destroy(body);
    }
    bad = *p.table;
    bad.node_count = bad.corner_count = SB_MAX_ELEMENT_NODES + 1;
    CHECK_RESULT(sb_element_table_check(&bad, NULL), SB_ERROR_ARGUMENT);
    bad = *p.table;
    bad.corner_count = 4;
    CHECK_RESULT(sb_element_table_check(&bad, NULL), SB_ERROR_ARGUMENT);
    bad = *p.table;
    bad.vtk_type = 12;
    CHECK_RESULT(sb_element_table_check(&bad, NULL), SB_ERROR_ARGUMENT);
    bad = *p.table;
    bad.name = NULL;
    CHECK_RESULT(sb_element_table_check(&bad, NULL), SB_ERROR_ARGUMENT);
    sb_particles_free(&p);
    cloud_free(&cloud);
}

/* ---- shapes, regions, rows ---- */

static void test_shapes(void)
{
    sb_mesh skin = make_organ_skin();
    sb_surface *surface = NULL;
    sb_surface_report report;
    CHECK_OK(sb_surface_create(&skin, NULL, &surface, NULL));
    CHECK_OK(sb_surface_check(&skin, NULL, &report, NULL));
    for (int method = 1; method <= 3; method++) {
        sb_particles_def def = sb_default_particles_def();
        sb_particles p;
        sb_grid_rows rows;
        double worst = 0, area = 0;
        def.method = (sb_particle_method)method;
        def.outer.surface = surface;
        def.cells = 12;
        p = make_particles(&def);
        CHECK_NEAR(p.volume / report.volume, 1, 0.02);
        CHECK(p.mesh.node_count > 200);
        if (CHECK_OK(sb_particles_map_surface(&p, &skin, NULL, 0, NULL, &rows, NULL))) {
            sb_vec3 *at = (sb_vec3 *)calloc((size_t)rows.rows.row_count, sizeof(sb_vec3));
            sb_mapping_apply(&rows.rows, p.mesh.nodes, at);
            for (int i = 0; i < rows.rows.row_count; i++) {
                worst = fmax(worst, (double)sb_v3_norm(sb_v3_sub(at[i], rows.points[i])));
                area += (double)rows.areas[i];
            }
            free(at);
            sb_grid_rows_free(&rows);
        }
        CHECK_NEAR(worst / (double)p.spacing, 0, scene_tolerance(1e-10, 1e5));
        CHECK_NEAR(area / (double)report.area, 1, scene_tolerance(1e-12, 1000));
        sb_particles_free(&p);
    }
    sb_surface_destroy(surface);
    sb_mesh_free(&skin);
}

static sb_real ball_distance(void *user, sb_vec3 x)
{
    return sb_v3_norm(sb_v3_sub(x, sb_v3(REAL(0.5), REAL(0.5), REAL(0.5)))) - *(const sb_real *)user;
}

static void test_regions(void)
{
    sb_real radius = REAL(0.3);
    for (int method = 1; method <= 3; method++)
        for (int hole = 0; hole < 2; hole++) {
            unsigned long long seed = 2;
            sb_particles_def def = sb_default_particles_def();
            particle_cloud cloud = random_cloud(&seed, 8, 8, 8, 1, 0);
            double inside = 0, all = 0, exact = 4.18879 * 0.027;
            sb_shape ball;
            sb_particles p;
            memset(&ball, 0, sizeof ball);
            ball.distance = ball_distance;
            ball.max_slope = 1;
            ball.user = &radius;
            ball.region = hole ? SB_GRID_EMPTY : 7;
            cloud_use(&cloud, &def);
            def.points = NULL;
            def.point_count = 0;
            def.cells = 12;
            def.counts[0] = def.counts[1] = def.counts[2] = 0;
            def.method = (sb_particle_method)method;
            def.inner = &ball;
            def.inner_count = 1;
            p = make_particles(&def);
            for (int e = 0; e < p.mesh.element_count; e++) {
                all += (double)p.domain.weights[e];
                inside += p.mesh.regions[e] == 7 ? (double)p.domain.weights[e] : 0;
            }
            CHECK_NEAR(all, hole ? 1 - exact : 1, 0.01);
            CHECK_NEAR(inside, hole ? 0 : exact, method == 3 ? 0.01 : 0.03);
            sb_particles_free(&p);
            cloud_free(&cloud);
        }
}

/* ---- cuts ---- */

/* No point has a neighbour across; what is left of each half is what it was. */
static void test_cut(void)
{
    for (int round = 0; round < 6; round++) {
        unsigned long long seed = 31;
        sb_particles_def def = sb_default_particles_def();
        particle_cloud cloud = random_cloud(&seed, 7, 5, 5, 1, round % 2 ? 0.2 : 0);
        sb_mesh sheet = make_sheet(REAL(0.5), -1, 2), other = make_sheet(REAL(0.21), -1, 2);
        sb_index_table parts;
        sb_particles p;
        int across = 0, count = 0;
        double value, slope, volume;
        def.method = (sb_particle_method)(1 + round / 2);
        cloud_use(&cloud, &def);
        p = make_particles(&def);
        volume = (double)p.volume;
        CHECK_OK(sb_mesh_components(&p.mesh, NULL, &parts, &count, NULL));
        CHECK_INT(count, 1);
        sb_index_table_free(&parts);
        CHECK_OK(sb_particles_cut(&p, &sheet, NULL));
        CHECK_OK(sb_particles_cut(&p, &other, NULL));
        CHECK_INT(p.cut_count, 2);
        CHECK_NEAR(p.volume, volume, 0);
        for (int e = 0; e < p.mesh.element_count; e++)
            for (int a = 0; a < p.domain.nodes_per_cell; a++) {
                sb_vec3 x = p.mesh.nodes[p.domain.cells[e * p.domain.nodes_per_cell + a]];
                across += (x.x < REAL(0.5)) != (p.points[e].x < REAL(0.5));
                across += (x.x < REAL(0.21)) != (p.points[e].x < REAL(0.21));
            }
        CHECK_INT(across, 0);
        CHECK_OK(sb_mesh_components(&p.mesh, NULL, &parts, &count, NULL));
        CHECK_INT(count, 3);
        sb_index_table_free(&parts);
        worst_error(&p, &seed, 0, &value, &slope);
        if (def.method != SB_PARTICLES_SPH && p.lost == 0)
            CHECK_NEAR(slope, 0, scene_tolerance(1e-11, 1e5));
        sb_particles_free(&p);
        sb_mesh_free(&sheet);
        sb_mesh_free(&other);
        cloud_free(&cloud);
    }
}

/* ---- threads, memory, arguments ---- */

static unsigned long long particles_hash(const sb_particles *p)
{
    size_t cells = (size_t)p->mesh.element_count, n = (size_t)p->domain.nodes_per_cell;
    unsigned long long hash = scene_hash(p->domain.cells, cells * n * sizeof(int));
    hash = hash * 31 + scene_hash(p->domain.gradients, cells * n * 3 * sizeof(sb_real));
    hash = hash * 31 + scene_hash(p->domain.weights, cells * sizeof(sb_real));
    return hash * 31 + scene_hash(p->domain.cell_mass, cells * n * (n + 1) / 2 * sizeof(sb_real));
}

static void test_threads(void)
{
    for (int method = 1; method <= 3; method++) {
        unsigned long long first = 0;
        for (int workers = 1; workers <= 16; workers = workers * 2 + (workers == 1)) {
            unsigned long long seed = 8;
            sb_particles_def def = sb_default_particles_def();
            particle_cloud cloud = random_cloud(&seed, 6, 6, 6, 1, 0.2);
            sb_mesh sheet = make_sheet(REAL(0.4), 0, REAL(0.6));
            sb_particles p;
            def.method = (sb_particle_method)method;
            def.jobs = scene_jobs(&workers);
            cloud_use(&cloud, &def);
            p = make_particles(&def);
            CHECK_OK(sb_particles_cut(&p, &sheet, NULL));
            if (workers == 1)
                first = particles_hash(&p);
            CHECK(particles_hash(&p) == first);
            sb_particles_free(&p);
            sb_mesh_free(&sheet);
            cloud_free(&cloud);
        }
    }
}

static void test_memory(void)
{
    for (int method = 1; method <= 3; method++)
        for (int fail = 1, failed = 1; failed; fail++) {
            unsigned long long seed = 8, before;
            scene_memory memory = {0, 0, 0, 0};
            sb_particles_def def = sb_default_particles_def();
            particle_cloud cloud = random_cloud(&seed, 3, 3, 3, 1, 0.1);
            sb_mesh sheet = make_sheet(REAL(0.45), -1, 2);
            sb_particles p, untouched;
            sb_grid_rows rows;
            sb_allocator allocator = scene_allocator(&memory);
            sb_error error;
            memset(&p, 0, sizeof p);
            untouched = p;
            def.method = (sb_particle_method)method;
            def.allocator = allocator;
            cloud_use(&cloud, &def);
            memory.fail_at = fail;
            failed = sb_particles_create(&def, &p, &error) != SB_OK;
            if (failed) {
                CHECK(error.result == SB_ERROR_MEMORY && memcmp(&p, &untouched, sizeof p) == 0);
            } else {
                int calls = memory.calls;
                before = particles_hash(&p);
                memory.fail_at = calls + fail;
                failed = sb_particles_cut(&p, &sheet, &error) != SB_OK;
                CHECK(!failed || (error.result == SB_ERROR_MEMORY && particles_hash(&p) == before && p.cut_count == 0));
            }
            for (int again = 1, short_of = 1; !failed && short_of; again++) {
                memory.fail_at = memory.calls + again;
                short_of = sb_particles_map_surface(&p, &cloud.skin, NULL, 0, &allocator, &rows, &error) != SB_OK;
                CHECK(!short_of || error.result == SB_ERROR_MEMORY);
                if (!short_of)
                    sb_grid_rows_free(&rows);
            }
            memory.fail_at = 0;
            failed = failed || (fail < 40 && p.table == NULL);
            sb_particles_free(&p);
            CHECK_INT(memory.live, 0);
            sb_mesh_free(&sheet);
            cloud_free(&cloud);
        }
}

/* Tries one changed definition. */
static void refuse(const sb_particles_def *def, sb_result expected, const char *word)
{
    sb_particles p, untouched;
    sb_error error;
    memset(&p, 0, sizeof p);
    untouched = p;
    memset(&error, 0, sizeof error);
    CHECK_RESULT(sb_particles_create(def, &p, &error), expected);
    CHECK(strstr(error.message, word) != NULL);
    CHECK(memcmp(&p, &untouched, sizeof p) == 0);
}

static void test_arguments(void)
{
    unsigned long long seed = 8;
    particle_cloud cloud = random_cloud(&seed, 4, 4, 4, 1, 0.1);
    sb_particles_def good = sb_default_particles_def(), def;
    sb_vec3 kept = cloud.points[17];
    sb_grid_rows rows;
    sb_error error;
    sb_particles p;
    sb_vec3 point;
    cloud_use(&cloud, &good);
#define REFUSE(change, expected, word)                                                                                 \
    def = good;                                                                                                        \
    change;                                                                                                            \
    refuse(&def, expected, word)
    check_bad_numbers();
    REFUSE(def.cookie = 0, SB_ERROR_ARGUMENT, "sb_default_particles_def");
    REFUSE(def.method = (sb_particle_method)4, SB_ERROR_ARGUMENT, "method");
    REFUSE(def.kernel = (sb_kernel)0, SB_ERROR_ARGUMENT, "kernel");
    REFUSE(def.radius_rule = (sb_radius_rule)7, SB_ERROR_ARGUMENT, "radius_rule");
    REFUSE(def.radius_rule = SB_RADIUS_FIXED, SB_ERROR_ARGUMENT, "radius");
    REFUSE(def.radius = REAL(NAN), SB_ERROR_ARGUMENT, "radius");
    REFUSE(def.dilatation = REAL(0.9), SB_ERROR_ARGUMENT, "dilatation");
    REFUSE(def.dilatation = REAL(NAN), SB_ERROR_ARGUMENT, "dilatation");
    REFUSE(def.neighbours = 3, SB_ERROR_ARGUMENT, "neighbours");
    REFUSE(def.neighbours = 32, SB_ERROR_ARGUMENT, "neighbours");
    REFUSE(def.neighbours = 7, SB_ERROR_ARGUMENT, "def.basis 4 needs");
    REFUSE(def.basis = 10, SB_ERROR_ARGUMENT, "def.basis 10 needs");
    REFUSE(def.basis = 5, SB_ERROR_ARGUMENT, "basis");
    REFUSE(def.points_per_cell = 2, SB_ERROR_ARGUMENT, "points_per_cell");
    REFUSE(def.level = 9, SB_ERROR_ARGUMENT, "level");
    REFUSE(def.consistent = -1, SB_ERROR_ARGUMENT, "consistent");
    REFUSE(def.volume = -1, SB_ERROR_ARGUMENT, "volume");
    REFUSE(def.spacing = -1; def.counts[0] = def.counts[1] = def.counts[2] = 0, SB_ERROR_ARGUMENT, "cell_size");
    REFUSE(def.outer.surface = NULL, SB_ERROR_ARGUMENT, "outer");
    REFUSE(def.points = NULL, SB_ERROR_ARGUMENT, "point_count");
    REFUSE(def.point_count = 4, SB_ERROR_ARGUMENT, "point_count");
    REFUSE(def.radius_rule = SB_RADIUS_FIXED; def.radius = 2, SB_ERROR_UNSUPPORTED, "31");
    cloud.points[17].y = REAL(INFINITY);
    REFUSE(def.basis = 4, SB_ERROR_NOT_FINITE, "17");
    cloud.points[17] = cloud.points[3];
    REFUSE(def.basis = 4, SB_ERROR_MESH, "is where particle");
    cloud.points[17] = kept;
    for (int i = 0; i < cloud.count; i++)
        cloud.points[i].z = REAL(0.5);
    REFUSE(def.method = SB_PARTICLES_MLS, SB_ERROR_MESH, "");
#undef REFUSE
    cloud_free(&cloud);
    cloud = random_cloud(&seed, 4, 4, 4, 1, 0.1);
    cloud_use(&cloud, &good);
    p = make_particles(&good);
    point = sb_v3(3, 0, 0);
    CHECK_RESULT(sb_particles_map_points(&p, &point, 1, NULL, &rows, &error), SB_ERROR_ARGUMENT);
    point = sb_v3(REAL(NAN), 0, 0);
    CHECK_RESULT(sb_particles_map_points(&p, &point, 1, NULL, &rows, &error), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_particles_map_points(&p, &point, 0, NULL, &rows, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_particles_map_points(NULL, &point, 1, NULL, &rows, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_particles_cut(&p, &p.mesh, &error), SB_ERROR_ARGUMENT);
    CHECK_INT(p.cut_count, 0);
    sb_particles_free(&p);
    sb_particles_free(&p);
    sb_particles_free(NULL);
    cloud_free(&cloud);
}

/* One particle far away does not make others coincide; a cloud as large as numbers are has no volume. */
static void test_far(void)
{
    unsigned long long seed = 71;
    particle_cloud cloud = random_cloud(&seed, 4, 4, 4, 1, 0.2);
    sb_particles_def def = sb_default_particles_def();
    const double huge = SB_REAL_IS_FLOAT ? 1e14 : 1e110;
    sb_vec3 kept = cloud.points[30];
    sb_particles p;
    sb_error error;
    memset(&p, 0, sizeof p);
    def.method = SB_PARTICLES_MLS;
    def.points = cloud.points;
    def.point_count = cloud.count;
    cloud.points[30] = sb_v3(REAL(1e9), REAL(1e9), REAL(1e9));
    CHECK_RESULT(sb_particles_create(&def, &p, &error), SB_ERROR_UNSUPPORTED); /* all others are equally far */
    CHECK_INT(error.node, -1);
    CHECK(SB_REAL_IS_FLOAT || error.element == 30); /* in float distances to it do not tell others apart */
    cloud.points[30] = kept;
    check_bad_numbers();
    for (int i = 0; i < cloud.count; i++)
        cloud.points[i] = sb_v3_scale(REAL(huge), cloud.points[i]);
    CHECK_RESULT(sb_particles_create(&def, &p, &error), SB_ERROR_NOT_FINITE);
    CHECK(p.table == NULL);
    cloud_free(&cloud);
}

CHECK_SUITE(particles, {"kernels", test_kernels}, {"complete", test_complete}, {"incomplete", test_incomplete},
            {"slopes", test_slopes}, {"volumes", test_volumes}, {"consistent", test_consistent},
            {"mirrors", test_mirrors}, {"nearest", test_nearest}, {"clouds", test_clouds}, {"shapes", test_shapes},
            {"regions", test_regions}, {"cut", test_cut}, {"threads", test_threads}, {"memory", test_memory},
            {"arguments", test_arguments}, {"far", test_far});
