/* Elements in several organs: shares against volumes in closed form, bodies of mixtures against plain ones, stiffness
 * against layered bars in closed form and meshes that fit. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

/* ---- shapes ---- */

/* Inside: normal . x < offset, or a ball where the radius is positive. */
typedef struct cutter {
    sb_vec3 normal, centre;
    double offset, radius;
} cutter;

static sb_real cutter_distance(void *user, sb_vec3 x)
{
    const cutter *c = (const cutter *)user;
    if (c->radius > 0)
        return REAL((double)sb_v3_norm(sb_v3_sub(x, c->centre)) - c->radius);
    return REAL((double)sb_v3_dot(c->normal, x) - c->offset);
}

static sb_shape cutter_shape(cutter *c, int region)
{
    sb_shape shape;
    memset(&shape, 0, sizeof shape);
    shape.distance = cutter_distance;
    shape.user = c;
    shape.max_slope = 1;
    shape.region = region;
    return shape;
}

static cutter make_plane(sb_vec3 normal, double offset)
{
    cutter c;
    memset(&c, 0, sizeof c);
    c.normal = sb_v3_scale(1 / sb_v3_norm(normal), normal);
    c.offset = offset;
    return c;
}

static cutter make_ball(sb_vec3 centre, double radius)
{
    cutter c;
    memset(&c, 0, sizeof c);
    c.centre = centre;
    c.radius = radius;
    return c;
}

/* Components in [low, high], drawn in order. */
static sb_vec3 random_point(unsigned long long *seed, double low, double high)
{
    sb_vec3 p;
    p.x = REAL(check_random_in(seed, low, high));
    p.y = REAL(check_random_in(seed, low, high));
    p.z = REAL(check_random_in(seed, low, high));
    return p;
}

/* Volume of the box [0, size] where n . x < c, all components of n positive. */
static double volume_below(sb_vec3 n, double c, sb_vec3 size)
{
    double sum = 0;
    for (int corner = 0; corner < 8; corner++) {
        double at = 0, rest;
        at += corner & 1 ? (double)n.x * (double)size.x : 0;
        at += corner & 2 ? (double)n.y * (double)size.y : 0;
        at += corner & 4 ? (double)n.z * (double)size.z : 0;
        rest = fmax(c - at, 0);
        sum += ((corner & 1) + (corner >> 1 & 1) + (corner >> 2)) % 2 ? -rest * rest * rest : rest * rest * rest;
    }
    return sum / (6 * (double)n.x * (double)n.y * (double)n.z);
}

/* ---- mixtures ---- */

static int make_mean(const sb_mesh *mesh, const sb_shape *shapes, int count, int level, sb_mixture_mean mean,
                     const sb_real *stiffness, sb_mixture *mixture)
{
    sb_mixture_def def = sb_default_mixture_def();
    sb_error error;
    sb_result result;
    def.mesh = mesh;
    def.shapes = shapes;
    def.shape_count = count;
    def.level = level;
    def.mean = mean;
    def.stiffness = stiffness;
    def.least_share = 0;
    memset(mixture, 0, sizeof *mixture);
    result = sb_mixture_create(&def, mixture, &error);
    if (result != SB_OK)
        printf("%s\n", error.message);
    return CHECK_OK(result);
}

static int make_mixture(const sb_mesh *mesh, const sb_shape *shapes, int count, int level, sb_mixture *mixture)
{
    return make_mean(mesh, shapes, count, level, SB_MIXTURE_VOIGT, NULL, mixture);
}

static double region_volume(const sb_mixture *mixture, int region)
{
    for (int k = 0; k < mixture->region_count; k++)
        if (mixture->regions[k] == region)
            return (double)mixture->region_volumes[k];
    return 0;
}

/* Shares of each element sum to 1, the largest stands first, its parts are side by side. */
static void check_shares(const sb_mesh *mesh, const sb_mixture *m)
{
    int e = -1, mixed = 0, bad = 0;
    double sum = 1, volume = (double)sb_mesh_volume(mesh), total = 0;
    for (int k = 0; k < m->body_mesh.element_count; k++) {
        if (m->elements[k] != e) {
            bad += m->elements[k] != e + 1 || !(fabs(sum - 1) < scene_tolerance(1e-12, 8));
            e = m->elements[k];
            sum = 0;
        } else {
            mixed += k < 2 || m->elements[k - 2] != e;
            bad += !(m->shares[k - 1] >= m->shares[k]) && (k < 2 || m->elements[k - 2] != e);
        }
        sum += (double)m->shares[k];
        for (int p = 0; p < m->domain.points_per_cell; p++)
            total += (double)m->domain.weights[(size_t)k * (size_t)m->domain.points_per_cell + (size_t)p];
    }
    CHECK_INT(bad, 0);
    CHECK_INT(e, mesh->element_count - 1);
    CHECK_INT(mixed, m->mixed_count);
    CHECK_NEAR((double)m->volume / volume, 1, scene_tolerance(1e-12, 100));
    CHECK_NEAR(total / volume, 1, scene_tolerance(1e-12, 100));
}

static const sb_element_type element_types[5] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};

static void test_planes(void)
{
    unsigned long long seed = 5;
    double worst = 0;
    for (int k = 0; k < 30; k++) {
        double scale = k % 3 == 0 ? 1e-3 : k % 3 == 1 ? 1 : 1e3, exact;
        sb_vec3 size = sb_v3(REAL(scale), REAL(1.3 * scale), REAL(0.7 * scale));
        int is_tet = element_types[k % 5] == SB_TET4 || element_types[k % 5] == SB_TET10;
        sb_mesh mesh = scene_box(element_types[k % 5], 3, 4, 2, size, is_tet ? 0.2 : 0);
        cutter plane = make_plane(random_point(&seed, 0.1, 1), 0);
        sb_shape shape = cutter_shape(&plane, 7);
        sb_mixture m;
        plane.offset = check_random_in(&seed, 0.1, 0.9) * (double)sb_v3_dot(plane.normal, size);
        if (make_mixture(&mesh, &shape, 1, 1 + k % 4, &m)) {
            exact = volume_below(plane.normal, plane.offset, size);
            check_shares(&mesh, &m);
            worst = fmax(worst, fabs(region_volume(&m, 7) - exact) / (double)m.volume);
            CHECK(m.mixed_count > 0);
        }
        sb_mixture_free(&m);
        sb_mesh_free(&mesh);
    }
    printf("  planes: volume off by %.2g of all\n", worst);
    CHECK(worst < scene_tolerance(1e-11, 100));
}

/* Bounds of l^2 / (8 R) on a ball's surface, and a fourth with twice the level. */
static void test_ball(void)
{
    sb_vec3 size = sb_v3(1, 1, 1);
    for (int type = 0; type < 5; type++) {
        double off[2], exact = 4 * 3.14159265358979323846 / 3 * 0.37 * 0.37 * 0.37;
        sb_mesh mesh = scene_box(element_types[type], 4, 4, 4, size, 0.15);
        cutter ball = make_ball(sb_v3(REAL(0.48), REAL(0.53), REAL(0.51)), 0.37);
        sb_shape shape = cutter_shape(&ball, 3);
        for (int k = 0; k < 2; k++) {
            int level = 2 << k;
            double l = sqrt(3.0) * 0.25 * 1.4 / level, moved = l * l / (8 * 0.37);
            sb_mixture m;
            off[k] = 0;
            if (make_mixture(&mesh, &shape, 1, level, &m)) {
                check_shares(&mesh, &m);
                off[k] = fabs(region_volume(&m, 3) - exact);
                CHECK(off[k] < moved * 3 * exact / 0.37);
            }
            sb_mixture_free(&m);
        }
        printf("  %s: ball off by %.2g, %.2g\n", sb_element_name(element_types[type]), off[0] / exact, off[1] / exact);
        CHECK(off[1] < 0.4 * off[0] || off[1] < 3e-4 * exact);
        sb_mesh_free(&mesh);
    }
}

/* Three half spaces that overlap in one another's elements: the last counts; the first has the third's region. */
static void test_overlap(void)
{
    sb_vec3 size = sb_v3(1, 1, 1);
    for (int type = 0; type < 5; type++) {
        sb_mesh mesh = scene_box(element_types[type], 2, 2, 2, size, 0);
        cutter planes[3] = {make_plane(sb_v3(1, 0, 0), 0.3), make_plane(sb_v3(0, 1, 0), 0.35),
                            make_plane(sb_v3(0, 0, 1), 0.2)};
        sb_shape shapes[3] = {cutter_shape(planes, 4), cutter_shape(planes + 1, 2), cutter_shape(planes + 2, 4)};
        sb_mixture m;
        shapes[1].max_slope = 0; /* unknown: sampled everywhere */
        if (make_mixture(&mesh, shapes, 3, 3, &m)) {
            check_shares(&mesh, &m);
            CHECK_INT(m.region_count, 3);
            CHECK_NEAR(region_volume(&m, 2), 0.8 * 0.35, scene_tolerance(1e-11, 100));
            CHECK_NEAR(region_volume(&m, 4), 0.2 + 0.8 * 0.65 * 0.3, scene_tolerance(1e-11, 100));
            CHECK_NEAR(region_volume(&m, 0), 0.8 * 0.65 * 0.7, scene_tolerance(1e-11, 100));
        }
        sb_mixture_free(&m);
        sb_mesh_free(&mesh);
    }
}

/* A closed surface of triangles as a shape: its volume, by shares. */
static void test_surface(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 5, 5, 5, sb_v3(1, 1, 1), 0.2), organ;
    sb_boundary boundary;
    sb_surface *surface = NULL;
    sb_shape shape;
    sb_mixture m;
    memset(&organ, 0, sizeof organ);
    memset(&shape, 0, sizeof shape);
    CHECK_OK(sb_mesh_ellipsoid(SB_TET4, sb_v3(REAL(0.3), REAL(0.2), REAL(0.25)), 12, NULL, &organ, NULL));
    for (int i = 0; i < organ.node_count; i++)
        organ.nodes[i] = sb_v3_add(organ.nodes[i], sb_v3(REAL(0.5), REAL(0.52), REAL(0.47)));
    CHECK_OK(sb_mesh_boundary(&organ, 1, NULL, &boundary, NULL));
    CHECK_OK(sb_surface_create(&boundary.surface, NULL, &surface, NULL));
    shape.surface = surface;
    shape.region = 1;
    if (make_mixture(&mesh, &shape, 1, 8, &m)) {
        check_shares(&mesh, &m);
        CHECK_NEAR(region_volume(&m, 1) / (double)sb_mesh_volume(&organ), 1, 0.01);
    }
    sb_mixture_free(&m);
    sb_surface_destroy(surface);
    for (int t = 0; t < boundary.surface.element_count; t++) { /* inside out */
        int *corners = boundary.surface.elements + 3 * (size_t)t, first = corners[0];
        corners[0] = corners[1];
        corners[1] = first;
    }
    surface = NULL;
    CHECK_OK(sb_surface_create(&boundary.surface, NULL, &surface, NULL));
    shape.surface = surface;
    {
        sb_mixture_def def = sb_default_mixture_def();
        def.mesh = &mesh;
        def.shapes = &shape;
        def.shape_count = 1;
        CHECK_RESULT(sb_mixture_create(&def, &m, NULL), SB_ERROR_MESH);
    }
    sb_surface_destroy(surface);
    sb_boundary_free(&boundary);
    sb_mesh_free(&organ);
    sb_mesh_free(&mesh);
}

/* ---- bodies ---- */

/* Pulled along an axis by 1 %, held across at both ends where `across` is 1, else free to narrow: force (N). */
static double pull(const sb_mesh *mesh, const sb_mixture *mixture, const double young[2], double poisson, int axis,
                   int across, double *mass)
{
    sb_body_def def = sb_default_body_def();
    sb_region_material inner;
    sb_static_options options = sb_default_static_options();
    sb_vec3 low, high;
    double length, force = 0;
    sb_body *body;
    inner.region = 1;
    inner.material = sb_material_linear(REAL(young[1]), REAL(poisson), 2000);
    def.mesh = mixture ? &mixture->body_mesh : mesh;
    def.domain = mixture ? &mixture->domain : NULL;
    def.material = sb_material_linear(REAL(young[0]), REAL(poisson), 1000);
    def.region_materials = &inner;
    def.region_material_count = 1;
    body = scene_body(&def);
    if (!body)
        return 0;
    sb_mesh_bounds(mesh, &low, &high);
    length = (double)scene_component(high, axis);
    scene_fix_plane(body, mesh, axis, 0, across ? SB_XYZ : SB_X << axis);
    scene_fix_plane(body, mesh, axis, length, across ? SB_XYZ : SB_X << axis);
    if (!across)
        for (int other = 0; other < 3; other++)
            if (other != axis)
                scene_fix_plane(body, mesh, other, 0, SB_X << other);
    for (int i = 0; i < mesh->node_count; i++)
        if (fabs((double)scene_component(mesh->nodes[i], axis) - length) < 1e-5 * length) {
            sb_vec3 to = mesh->nodes[i];
            (axis == 0 ? &to.x : axis == 1 ? &to.y : &to.z)[0] += REAL(0.01 * length);
            CHECK_OK(sb_body_place(body, &i, 1, across ? SB_XYZ : SB_X << axis, &to, NULL));
        }
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    for (int i = 0; i < mesh->node_count; i++)
        if (fabs((double)scene_component(mesh->nodes[i], axis) - length) < 1e-5 * length)
            force += (double)scene_component(sb_body_reactions(body)[i], axis);
    if (mass)
        *mass = (double)sb_body_mass(body);
    sb_body_destroy(body);
    return force;
}

/* Where both regions have one material, bodies are the plain mesh's. */
static void test_one_material(void)
{
    const double young[2] = {1000, 1000};
    for (int type = 0; type < 5; type++) {
        sb_mesh mesh = scene_box(element_types[type], 2, 2, 2, sb_v3(1, 1, 1), 0.15);
        cutter ball = make_ball(sb_v3(REAL(0.4), REAL(0.5), REAL(0.5)), 0.3);
        sb_shape shape = cutter_shape(&ball, 1);
        double mass, plain;
        sb_mixture m;
        mesh.regions = (int *)calloc((size_t)mesh.element_count, sizeof(int)); /* one element has region 1 */
        mesh.regions[0] = 1;
        if (make_mixture(&mesh, &shape, 1, 3, &m)) {
            double volume = (double)m.volume, inner = region_volume(&m, 1);
            plain = pull(&mesh, NULL, young, 0.3, 0, 1, NULL);
            CHECK_NEAR(pull(&mesh, &m, young, 0.3, 0, 1, &mass) / plain, 1, scene_tolerance(1e-6, 1e4));
            CHECK_NEAR(mass, 1000 * (volume - inner) + 2000 * inner, scene_tolerance(1e-9, 1e3) * mass);
        }
        sb_mixture_free(&m);
        sb_mesh_free(&mesh);
    }
}

/* Layers along the pull, without narrowing: one strain in both, so that mixing by volume is exact. */
static void test_parallel_layers(void)
{
    const double young[2] = {1000, 10000};
    for (int type = 0; type < 5; type++) {
        sb_mesh mesh = scene_box(element_types[type], 3, 2, 2, sb_v3(1, 1, 1), 0);
        cutter plane = make_plane(sb_v3(0, 1, 0), 0.37);
        sb_shape shape = cutter_shape(&plane, 1);
        double exact = 0.01 * (0.37 * young[1] + 0.63 * young[0]), ratio;
        sb_mixture m;
        if (make_mixture(&mesh, &shape, 1, 4, &m)) {
            ratio = pull(&mesh, &m, young, 0, 0, 0, NULL) / exact;
            printf("  %s: %.5f\n", sb_element_name(element_types[type]), ratio);
            CHECK(ratio < 1 + 1e-4 && ratio > (type > 1 ? 1 - 1e-4 : 0.97));
        }
        sb_mixture_free(&m);
        sb_mesh_free(&mesh);
    }
}

/* One region for each element, the one with most of it: of a mixture the first part. */
static void label_mesh(sb_mesh *mesh, const sb_mixture *m)
{
    if (!mesh->regions)
        mesh->regions = (int *)calloc((size_t)mesh->element_count, sizeof(int));
    for (int k = m->body_mesh.element_count - 1; k >= 0; k--)
        mesh->regions[m->elements[k]] = m->body_mesh.regions[k];
}

/* What a ball adds to the stiffness of a block on a mesh of n^3 cells, without the mesh's own error: by mixture, or
 * by one label for each element. */
static double ball_stiffness(sb_element_type type, int n, cutter *ball, const double young[2], int mean)
{
    const double plain[2] = {young[0], young[0]};
    const sb_real stiffness[2] = {REAL(young[0]), REAL(young[1])};
    sb_mesh mesh = scene_box(type, n, n, n, sb_v3(1, 1, 1), 0);
    sb_shape shape = cutter_shape(ball, 1);
    double with = 0, without = 0;
    sb_mixture m;
    if (make_mean(&mesh, &shape, 1, 4, mean ? (sb_mixture_mean)mean : SB_MIXTURE_VOIGT, stiffness, &m)) {
        label_mesh(&mesh, &m);
        with = pull(&mesh, mean ? &m : NULL, young, 0.3, 0, 1, NULL);
        without = pull(&mesh, NULL, plain, 0.3, 0, 1, NULL);
    }
    sb_mixture_free(&m);
    sb_mesh_free(&mesh);
    return with - without;
}

/* Balls of random size and place, stiffer and softer: root of the mean square of the error of what they add, against
 * quadratic tets. Voigt's mean is an upper bound and does worse than labels; the others do better than they. */
static void test_ball_in_block(void)
{
    enum { BALLS = 3, MEANS = 4 };
    unsigned long long seed = 11;
    double all[MEANS] = {0};
    for (int soft = 0; soft < 2; soft++) {
        const double young[2] = {1000, soft ? 200.0 : 10000.0};
        double off[MEANS] = {0};
        for (int k = 0; k < BALLS; k++) {
            sb_vec3 centre = random_point(&seed, 0.4, 0.6);
            cutter ball = make_ball(centre, check_random_in(&seed, 0.17, 0.3));
            double right = ball_stiffness(SB_TET10, 6, &ball, young, SB_MIXTURE_GEOMETRIC), last = 0;
            for (int mean = 0; mean < MEANS; mean++) {
                double added = ball_stiffness(SB_TET4, 4, &ball, young, mean), error = added / right - 1;
                CHECK(mean < 2 || added < last); /* Voigt, geometric, Reuss: ever softer */
                last = added;
                off[mean] += error * error / (double)BALLS;
            }
        }
        printf("  ball of %g in 1000 Pa: labelled %.3g, Voigt %.3g, geometric %.3g, Reuss %.3g\n", young[1],
               sqrt(off[0]), sqrt(off[1]), sqrt(off[2]), sqrt(off[3]));
        for (int mean = 0; mean < MEANS; mean++)
            all[mean] += off[mean];
    }
    CHECK(all[SB_MIXTURE_REUSS] < 0.5 * all[0]);
    CHECK(all[SB_MIXTURE_GEOMETRIC] < 0.5 * all[0]);
}

/* Layers across the pull, each element's side to side: Reuss is exact where Voigt is not. */
static void test_layers_across(void)
{
    const double young[2] = {1000, 10000};
    const sb_real stiffness[2] = {1000, 10000};
    sb_mesh mesh = scene_box(SB_HEX8, 3, 2, 2, sb_v3(1, 1, 1), 0);
    cutter plane = make_plane(sb_v3(1, 0, 0), 0.45);
    sb_shape shape = cutter_shape(&plane, 1);
    double exact = 0.01 / (0.45 / young[1] + 0.55 / young[0]), mass;
    sb_mixture m;
    if (make_mean(&mesh, &shape, 1, 4, SB_MIXTURE_REUSS, stiffness, &m)) {
        CHECK_NEAR(pull(&mesh, &m, young, 0, 0, 0, &mass) / exact, 1, scene_tolerance(1e-4, 1e4));
        CHECK_NEAR(mass, 0.55 * 1000 + 0.45 * 2000, scene_tolerance(1e-9, 1e3) * mass);
    }
    sb_mixture_free(&m);
    if (make_mixture(&mesh, &shape, 1, 4, &m))
        CHECK(pull(&mesh, &m, young, 0, 0, 0, NULL) > 1.2 * exact);
    sb_mixture_free(&m);
    sb_mesh_free(&mesh);
}

/* ---- refusals ---- */

static sb_real no_distance(void *user, sb_vec3 x)
{
    (void)user;
    return x.x > REAL(0.7) ? REAL(NAN) : x.x - REAL(0.5);
}

static void test_refusals(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 2, 2, 2, sb_v3(1, 1, 1), 0);
    cutter plane = make_plane(sb_v3(1, 0, 0), 0.5);
    sb_shape shape = cutter_shape(&plane, 1), bad = shape;
    sb_mixture_def def = sb_default_mixture_def();
    sb_mixture m;
    sb_error error;
    memset(&m, 0, sizeof m);
    def.mesh = &mesh;
    def.shapes = &shape;
    def.shape_count = 1;
    CHECK_RESULT((def.level = 0, sb_mixture_create(&def, &m, &error)), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "level") != NULL);
    CHECK_RESULT((def.level = 17, sb_mixture_create(&def, &m, &error)), SB_ERROR_ARGUMENT);
    def.level = 2;
    CHECK_RESULT((def.least_share = REAL(0.5), sb_mixture_create(&def, &m, &error)), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "least_share") != NULL);
    def.least_share = 0;
    CHECK_RESULT((def.shape_count = 31, sb_mixture_create(&def, &m, &error)), SB_ERROR_ARGUMENT);
    def.shape_count = 1;
    def.shapes = &bad;
    bad.distance = NULL;
    CHECK_RESULT(sb_mixture_create(&def, &m, &error), SB_ERROR_ARGUMENT);
    bad.distance = no_distance;
    CHECK_RESULT(sb_mixture_create(&def, &m, &error), SB_ERROR_NOT_FINITE);
    CHECK(error.element >= 0 && error.element < mesh.element_count);
    def.shapes = &shape;
    def.mean = SB_MIXTURE_REUSS; /* without stiffnesses */
    CHECK_RESULT(sb_mixture_create(&def, &m, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "stiffness") != NULL);
    def.mean = SB_MIXTURE_VOIGT;
    def.single_rotation = 1; /* of tet10 only */
    CHECK_RESULT(sb_mixture_create(&def, &m, &error), SB_ERROR_ARGUMENT);
    CHECK(m.elements == NULL);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(mixture, {"planes: volumes in closed form", test_planes}, {"balls", test_ball},
            {"shapes that overlap", test_overlap}, {"closed surfaces", test_surface},
            {"one material", test_one_material}, {"layers along the pull", test_parallel_layers},
            {"layers across the pull", test_layers_across}, {"a ball in a block", test_ball_in_block},
            {"refusals", test_refusals});
