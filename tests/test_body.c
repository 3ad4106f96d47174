/* Bodies: patch tests, convergence orders, supports, loads, balances, readings, set-up check, failures. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

static const sb_element_type element_types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
enum { ELEMENT_TYPES = 5 };

static sb_material test_material(int model)
{
    switch (model) {
    case 0: return sb_material_linear(REAL(5e3), REAL(0.3), REAL(1000));
    case 1: return sb_material_corotated(REAL(5e3), REAL(0.3), REAL(1000));
    case 2: return sb_material_corotated_invertible(REAL(5e3), REAL(0.3), REAL(1000));
    case 3: return sb_material_svk(REAL(5e3), REAL(0.3), REAL(1000));
    case 4: return sb_material_neo_hookean(REAL(5e3), REAL(0.3), REAL(1000));
    case 5: return sb_material_neo_hookean_isochoric(REAL(961.5), REAL(4.8e-4), REAL(1000));
    default: return sb_material_stable_neo_hookean(REAL(5e3), REAL(0.3), REAL(1000));
    }
}
enum { MODELS = 7 };

/* An affine motion with rotation, stretch and shear. */
static sb_vec3 affine(sb_vec3 x, double size)
{
    double s = size;
    return sb_v3(REAL(0.10 * (double)x.x + 0.04 * (double)x.y - 0.03 * (double)x.z + 0.01 * s),
                 REAL(-0.02 * (double)x.x - 0.05 * (double)x.y + 0.06 * (double)x.z),
                 REAL(0.05 * (double)x.x + 0.02 * (double)x.y + 0.07 * (double)x.z - 0.02 * s));
}

/* Patch test: boundary nodes on an affine motion, interior nodes (out of place) must find it. */
static void patch_test(sb_element_type type, int model, int single_rotation)
{
    sb_mesh mesh = scene_box(type, 3, 3, 3, sb_v3(1, 1, 1), 0.2);
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    sb_vec3 *expected = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
    sb_body *body;
    sb_energy energy;
    def.mesh = &mesh;
    def.material = test_material(model);
    def.single_rotation = single_rotation;
    body = scene_body(&def);
    options.tolerance = REAL(1e-13);
    scene_fix_boundary(body, &mesh);
    for (int i = 0; i < mesh.node_count; i++) {
        expected[i] = affine(mesh.nodes[i], 1);
        if (sb_body_supports(body)[i])
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &expected[i], 1));
    }
    if (CHECK_OK(sb_body_solve_static(body, &options, &info)))
        CHECK_NEAR(scene_distance(sb_body_displacements(body), expected, mesh.node_count), 0,
                   scene_tolerance(1e-12, 100));
    else
        printf("%s model %d: %s\n", sb_element_name(type), model, info.error.message);
    CHECK_OK(sb_body_energy(body, &energy));
    CHECK(energy.elastic > 0);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(expected);
}

static void test_patch(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++)
        for (int m = 0; m < MODELS; m++)
            patch_test(element_types[t], m, 0);
    patch_test(SB_TET10, 1, 1);
}

/* Curved interior sides: the 8-point rule of tet10 must pass, as the formula sheet says it does, and hexes with 27. */
static void patch_test_curved(sb_element_type type, int model, int points)
{
    sb_mesh mesh = scene_box(type, 2, 2, 2, sb_v3(1, 1, 1), 0);
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_vec3 *expected = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
    unsigned long long seed = 3;
    sb_body *body;
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 *x = mesh.nodes + i;
        double inside = (double)(x->x * (1 - x->x) * x->y * (1 - x->y) * x->z * (1 - x->z));
        if (inside > 1e-9) {
            x->x += REAL(check_random_in(&seed, -0.03, 0.03));
            x->y += REAL(check_random_in(&seed, -0.03, 0.03));
            x->z += REAL(check_random_in(&seed, -0.03, 0.03));
        }
    }
    def.mesh = &mesh;
    def.material = test_material(model);
    body = scene_body(&def);
    CHECK_INT(sb_body_point_count(body), points);
    options.tolerance = REAL(1e-13);
    scene_fix_boundary(body, &mesh);
    for (int i = 0; i < mesh.node_count; i++) {
        expected[i] = affine(mesh.nodes[i], 1);
        if (sb_body_supports(body)[i])
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &expected[i], 1));
    }
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    CHECK_NEAR(scene_distance(sb_body_displacements(body), expected, mesh.node_count), 0, scene_tolerance(1e-12, 100));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(expected);
}

static void test_patch_curved(void)
{
    patch_test_curved(SB_TET10, 4, 8);
    for (int m = 0; m < MODELS; m++) {
        patch_test_curved(SB_HEX20, m, 27);
        patch_test_curved(SB_HEX27, m, 27);
    }
}

/* ---- manufactured solution: order of convergence in L2 ---- */

static const double pi = 3.14159265358979323846;

/* u = 0.01 (sin pi x sin pi y sin pi z, x y z (1 - z), cos pi x sin pi y z^2) on the unit cube. */
static sb_vec3 exact(sb_vec3 p)
{
    double x = (double)p.x, y = (double)p.y, z = (double)p.z;
    return sb_v3(REAL(0.01 * sin(pi * x) * sin(pi * y) * sin(pi * z)), REAL(0.01 * x * y * z * (1 - z)),
                 REAL(0.01 * cos(pi * x) * sin(pi * y) * z * z));
}

/* b = -((lambda + mu) grad div u + mu lap u) of the field above. */
static void body_force(sb_vec3 p, double lambda, double mu, double *b)
{
    double x = (double)p.x, y = (double)p.y, z = (double)p.z;
    double sx = sin(pi * x), cx = cos(pi * x), sy = sin(pi * y), cy = cos(pi * y), sz = sin(pi * z), cz = cos(pi * z);
    double lap[3], grad_div[3];
    lap[0] = -3 * pi * pi * sx * sy * sz;
    lap[1] = -2 * x * y;
    lap[2] = -2 * pi * pi * cx * sy * z * z + 2 * cx * sy;
    /* div u = pi cx sy sz + x z (1 - z) + 2 z cx sy */
    grad_div[0] = -pi * pi * sx * sy * sz + z * (1 - z) - 2 * pi * z * sx * sy;
    grad_div[1] = pi * pi * cx * cy * sz + 2 * pi * z * cx * cy;
    grad_div[2] = pi * pi * cx * sy * cz + x * (1 - 2 * z) + 2 * cx * sy;
    for (int i = 0; i < 3; i++)
        b[i] = -0.01 * ((lambda + mu) * grad_div[i] + mu * lap[i]);
}

/* Position and shape functions at a mass quadrature point of an element; returns the integration weight. */
static double quadrature_point(const sb_mesh *mesh, int element, int p, sb_vec3 *x, sb_real *shape)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    sb_real gradient[SB_MAX_ELEMENT_NODES][3];
    int n = sb_element_node_count(mesh->element_type);
    const int *nodes = mesh->elements + (size_t)element * (size_t)n;
    sb_vec3 columns[3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
    if (p >= sb_element_quadrature(mesh->element_type, SB_QUADRATURE_MASS, points, weights))
        return -1;
    sb_element_shape(mesh->element_type, points[p], shape, gradient);
    *x = sb_v3(0, 0, 0);
    for (int a = 0; a < n; a++) {
        *x = sb_v3_madd(*x, shape[a], mesh->nodes[nodes[a]]);
        for (int j = 0; j < 3; j++)
            columns[j] = sb_v3_madd(columns[j], gradient[a][j], mesh->nodes[nodes[a]]);
    }
    return (double)(weights[p] * sb_m3_det(sb_m3_columns(columns[0], columns[1], columns[2])));
}

static double manufactured_error(sb_element_type type, int cells)
{
    sb_mesh mesh = scene_box(type, cells, cells, cells, sb_v3(1, 1, 1), 0);
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_real shape[SB_MAX_ELEMENT_NODES];
    int n = sb_element_node_count(type);
    double sum = 0;
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_linear(REAL(1000), REAL(0.3), REAL(1000));
    body = scene_body(&def);
    scene_fix_boundary(body, &mesh);
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 u = exact(mesh.nodes[i]);
        if (sb_body_supports(body)[i])
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u, 1));
    }
    for (int e = 0; e < mesh.element_count; e++)
        for (int p = 0;; p++) {
            sb_vec3 x, force;
            double b[3], w = quadrature_point(&mesh, e, p, &x, shape);
            if (w < 0)
                break;
            body_force(x, (double)def.material.lambda, (double)def.material.mu, b);
            for (int a = 0; a < n; a++) {
                force = sb_v3(REAL(w * b[0] * (double)shape[a]), REAL(w * b[1] * (double)shape[a]),
                              REAL(w * b[2] * (double)shape[a]));
                CHECK_OK(sb_body_add_forces(body, mesh.elements + (size_t)e * (size_t)n + a, 1, &force, 1));
            }
        }
    options.tolerance = REAL(1e-10);
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    for (int e = 0; e < mesh.element_count; e++)
        for (int p = 0;; p++) {
            sb_vec3 x, u = sb_v3(0, 0, 0);
            double w = quadrature_point(&mesh, e, p, &x, shape), d;
            if (w < 0)
                break;
            for (int a = 0; a < n; a++)
                u = sb_v3_madd(u, shape[a], sb_body_displacements(body)[mesh.elements[e * n + a]]);
            d = (double)sb_v3_norm(sb_v3_sub(u, exact(x)));
            sum += w * d * d;
        }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return sqrt(sum);
}

static void test_manufactured(void)
{
    static const int cells[ELEMENT_TYPES][2] = {{8, 16}, {4, 8}, {6, 12}, {4, 6}, {4, 6}};
    static const double least[ELEMENT_TYPES] = {1.9, 2.8, 1.9, 2.9, 2.9};
    if (SB_REAL_IS_FLOAT) { /* rounding hides the order of the finer meshes */
        CHECK_SKIP("convergence orders need double");
        return;
    }
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        double coarse = manufactured_error(element_types[t], cells[t][0]);
        double fine = manufactured_error(element_types[t], cells[t][1]);
        double slope = log(coarse / fine) / log((double)cells[t][1] / cells[t][0]);
        printf("  order %s: %.2f (errors %.3g %.3g)\n", sb_element_name(element_types[t]), slope, coarse, fine);
        CHECK(slope >= least[t]);
    }
}

/* ---- balances ---- */

static void test_static_balance(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++)
        for (int m = 0; m < MODELS; m++) {
            sb_mesh mesh = scene_box(element_types[t], 4, 2, 2, sb_v3(REAL(0.1), REAL(0.04), REAL(0.04)), 0.1);
            sb_body_def def = sb_default_body_def();
            sb_static_options options = sb_default_static_options();
            sb_vec3 pull = sb_v3(REAL(1e-3), REAL(2e-3), REAL(-1e-3)), reactions, loads;
            int tip = mesh.node_count - 1;
            sb_body *body;
            def.mesh = &mesh;
            def.material = test_material(m);
            def.gravity = sb_v3(0, REAL(-1), REAL(-5));
            body = scene_body(&def);
            scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
            CHECK_OK(sb_body_add_forces(body, &tip, 1, &pull, 1));
            options.tolerance = REAL(1e-11);
            CHECK_OK(sb_body_solve_static(body, &options, NULL));
            reactions = scene_sum(sb_body_reactions(body), mesh.node_count);
            loads = scene_sum(sb_body_external_forces(body), mesh.node_count);
            CHECK_NEAR(sb_v3_norm(sb_v3_add(reactions, loads)) / sb_v3_norm(loads), 0, scene_tolerance(1e-8, 3000));
            CHECK_NEAR(loads.z, -5 * (double)sb_body_mass(body) - 1e-3, scene_tolerance(1e-12, 100));
            sb_body_destroy(body);
            sb_mesh_free(&mesh);
        }
}

/* A cantilever under its weight, then under a tenth more of it: Newton's iterations of the second solve. */
static int quasi_newton(const sb_mesh *mesh, int model, double weight, int quasi, sb_vec3 *found)
{
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    sb_body *body;
    def.mesh = mesh;
    def.material = test_material(model);
    def.gravity = sb_v3(0, REAL(-0.4 * weight), REAL(-weight));
    body = scene_body(&def);
    scene_fix_plane(body, mesh, 0, 0, SB_XYZ);
    options.tolerance = sizeof(sb_real) == 4 ? REAL(1e-3) : REAL(1e-8);
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    sb_body_set_gravity(body, sb_v3_scale(REAL(1.1), def.gravity));
    options.quasi_newton = quasi;
    CHECK_OK(sb_body_solve_static(body, &options, &info));
    CHECK(info.residual <= (sizeof(sb_real) == 4 ? REAL(1e-2) : options.tolerance)); /* floats end at their rounding */
    memcpy(found, sb_body_displacements(body), (size_t)mesh->node_count * sizeof *found);
    sb_body_destroy(body);
    return info.newton_iterations;
}

/* Newton's method that begins with the tangent that leaves out how rotations change finds the same equilibrium: where
 * that converges (little weight), and where it does not (much of it, tet10) and the exact tangent takes over. */
static void test_quasi_newton(void)
{
    static const sb_element_type types[2] = {SB_TET4, SB_TET10};
    for (int t = 0; t < 2; t++) {
        sb_mesh mesh = scene_box(types[t], 8, 2, 2, sb_v3(REAL(0.2), REAL(0.04), REAL(0.04)), 0.1);
        size_t n = (size_t)mesh.node_count;
        sb_vec3 *exact = (sb_vec3 *)malloc(n * sizeof *exact), *quasi = (sb_vec3 *)malloc(n * sizeof *quasi);
        for (int m = 0; m < MODELS; m++)
            for (int much = 0; much < 2; much++) {
                double weight = much ? 0.5 : 0.01, most = 0;
                int least = quasi_newton(&mesh, m, weight, 0, exact), spent = quasi_newton(&mesh, m, weight, 1, quasi);
                CHECK(spent <= least + 1);
                CHECK_INT(memcmp(quasi, exact, n * sizeof *exact) != 0, m != 0); /* it went another way */
                for (size_t i = 0; i < n; i++)
                    most = fmax(most, (double)sb_v3_norm(exact[i]));
                CHECK(scene_distance(quasi, exact, mesh.node_count) < (sizeof(sb_real) == 4 ? 1e-2 : 1e-3) * most);
            }
        free(exact);
        free(quasi);
        sb_mesh_free(&mesh);
    }
}

static void test_traction_and_stress(void)
{
    /* A bar pulled at both ends: uniform stress in closed form, whatever the element. */
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        sb_mesh mesh = scene_box(element_types[t], 3, 2, 2, sb_v3(REAL(0.3), REAL(0.1), REAL(0.1)), 0.15);
        sb_body_def def = sb_default_body_def();
        sb_static_options options = sb_default_static_options();
        sb_boundary boundary;
        sb_mat3 stress;
        sb_error error;
        sb_real *values = (sb_real *)malloc((size_t)(mesh.node_count + mesh.element_count) * sizeof(sb_real));
        sb_body *body;
        def.mesh = &mesh;
        def.material = sb_material_linear(REAL(1e4), REAL(0.3), REAL(1000));
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_X);
        scene_fix_plane(body, &mesh, 1, 0, SB_Y);
        scene_fix_plane(body, &mesh, 2, 0, SB_Z);
        CHECK_OK(sb_mesh_boundary(&mesh, 0, NULL, &boundary, NULL));
        for (int f = 0; f < boundary.surface.element_count; f++) {
            int n = sb_element_node_count(boundary.surface.element_type);
            int corners = sb_element_corner_count(boundary.surface.element_type), at_end = 1;
            const int *face = boundary.surface.elements + f * n;
            for (int k = 0; k < corners; k++)
                at_end = at_end && mesh.nodes[face[k]].x > REAL(0.2999);
            if (at_end)
                CHECK_OK(sb_body_add_traction(body, face, 1, corners, sb_v3(100, 0, 0), &error));
        }
        options.tolerance = REAL(1e-11);
        CHECK_OK(sb_body_solve_static(body, &options, NULL));
        for (int e = 0; e < mesh.element_count; e++)
            for (int p = 0; p < sb_body_point_count(body); p++) {
                CHECK_OK(sb_body_stress(body, e, p, &stress));
                CHECK_NEAR(stress.m[0][0], 100, scene_tolerance(1e-6, 1e5));
                CHECK_NEAR(stress.m[1][1], 0, scene_tolerance(1e-6, 1e5));
                CHECK_NEAR(stress.m[0][1], 0, scene_tolerance(1e-6, 1e5));
            }
        CHECK_NEAR(sb_body_displacements(body)[mesh.node_count - 1].x, 0.01 * (double)mesh.nodes[mesh.node_count - 1].x,
                   scene_tolerance(1e-10, 100)); /* strain 100 Pa / 10 kPa */
        sb_body_von_mises(body, values);
        sb_body_nodal_von_mises(body, values + mesh.element_count);
        for (int i = 0; i < mesh.node_count + mesh.element_count; i++)
            CHECK_NEAR(values[i], 100, scene_tolerance(1e-6, 1e5));
        sb_boundary_free(&boundary);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(values);
    }
}

static void test_rigid_motion_is_free(void)
{
    /* A turn by 2.5 rad and a shift cost no energy for every model but the linear one. */
    sb_real c, s;
    sb_sin_cos(REAL(2.5), &s, &c);
    for (int t = 0; t < ELEMENT_TYPES; t++)
        for (int m = 1; m < MODELS; m++) {
            sb_mesh mesh = scene_box(element_types[t], 3, 2, 2, sb_v3(REAL(0.3), REAL(0.2), REAL(0.2)), 0.2);
            sb_body_def def = sb_default_body_def();
            sb_vec3 *u = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
            sb_energy energy;
            sb_body *body;
            def.mesh = &mesh;
            def.material = test_material(m);
            body = scene_body(&def);
            for (int i = 0; i < mesh.node_count; i++) {
                sb_vec3 x = mesh.nodes[i];
                u[i] = sb_v3((c - 1) * x.x - s * x.y + REAL(0.4), s * x.x + (c - 1) * x.y, REAL(-0.1));
            }
            CHECK_OK(sb_body_set_displacements(body, u));
            CHECK_OK(sb_body_energy(body, &energy));
            /* strains of rounding size e cost E e^2 V; energies made of differences like I1 - 3 lose E e V */
            CHECK_NEAR(energy.elastic, 0,
                       5e3 * 0.012 * (m <= 3 ? pow(200 * (double)SB_EPSILON, 2) : 20 * (double)SB_EPSILON));
            sb_body_destroy(body);
            sb_mesh_free(&mesh);
            free(u);
        }
}

/* ---- masses ---- */

static void test_mass(void)
{
    static const sb_mass_kind kinds[] = {SB_MASS_LUMPED, SB_MASS_CONSISTENT, SB_MASS_REDUCED};
    for (int t = 0; t < ELEMENT_TYPES; t++)
        for (int k = 0; k < 3; k++) {
            sb_mesh mesh = scene_box(element_types[t], 3, 2, 2, sb_v3(REAL(0.3), REAL(0.2), REAL(0.2)), 0.2);
            sb_body_def def = sb_default_body_def();
            sb_vec3 *v = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3)), momentum;
            sb_energy energy;
            sb_body *body;
            def.mesh = &mesh;
            def.material = test_material(1);
            def.mass = kinds[k];
            body = scene_body(&def);
            for (int i = 0; i < mesh.node_count; i++)
                v[i] = sb_v3(2, 0, -1);
            CHECK_OK(sb_body_set_velocities(body, v));
            CHECK_OK(sb_body_energy(body, &energy));
            momentum = sb_body_momentum(body);
            CHECK_NEAR(sb_body_mass(body), 12, scene_tolerance(1e-11, 100));
            CHECK_NEAR(momentum.x, 24, scene_tolerance(1e-11, 300));
            CHECK_NEAR(momentum.z, -12, scene_tolerance(1e-11, 300));
            CHECK_NEAR(energy.kinetic, 30, scene_tolerance(1e-11, 300));
            sb_body_destroy(body);
            sb_mesh_free(&mesh);
            free(v);
        }
}

/* Shares of an affine element's mass that HRZ lumping gives its nodes (formula sheet 1.4): corners, edges, faces,
 * centre. */
static void test_lumped_shares(void)
{
    static const double shares[ELEMENT_TYPES][4] = {{1.0 / 4, 0, 0, 0},
                                                    {1.0 / 36, 4.0 / 27, 0, 0},
                                                    {1.0 / 8, 0, 0, 0},
                                                    {7.0 / 248, 16.0 / 248, 0, 0},
                                                    {1.0 / 216, 1.0 / 54, 2.0 / 27, 8.0 / 27}};
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        sb_mesh mesh = scene_box(element_types[t], 1, 1, 1, sb_v3(2, 1, 1), 0);
        int corners = sb_element_corner_count(element_types[t]), edges = sb_element_edge_count(element_types[t]);
        sb_body_def def = sb_default_body_def();
        sb_body *body;
        mesh.element_count = 1;
        def.mesh = &mesh;
        def.material = test_material(1);
        body = scene_body(&def);
        for (int a = 0; a < sb_element_node_count(element_types[t]); a++) {
            int kind = a < corners ? 0 : (a < corners + edges ? 1 : (a < corners + edges + 6 ? 2 : 3));
            sb_vec3 *v = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof(sb_vec3));
            sb_energy energy;
            v[mesh.elements[a]].y = 1;
            CHECK_OK(sb_body_set_velocities(body, v));
            CHECK_OK(sb_body_energy(body, &energy));
            CHECK_NEAR(2 * energy.kinetic / sb_body_mass(body), shares[t][kind], scene_tolerance(1e-12, 32));
            free(v);
        }
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* Rank of a symmetric matrix by elimination with diagonal pivots; its entries are destroyed. */
static int rank_of(double *k, int n)
{
    double largest = 0;
    int rank = 0, done[3 * SB_MAX_ELEMENT_NODES] = {0};
    for (;; rank++) {
        int pivot = -1;
        for (int i = 0; i < n; i++)
            if (!done[i] && (pivot < 0 || k[i * n + i] > k[pivot * n + pivot]))
                pivot = i;
        if (rank == 0)
            largest = k[pivot * n + pivot];
        if (pivot < 0 || k[pivot * n + pivot] < 1e3 * (double)SB_EPSILON * largest)
            return rank;
        done[pivot] = 1;
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n && !done[i]; j++)
                if (!done[j])
                    k[i * n + j] -= k[i * n + pivot] * k[pivot * n + j] / k[pivot * n + pivot];
    }
}

/* An element resists everything but its six rigid motions: no motion escapes its points. */
static void test_rank(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        sb_mesh mesh = scene_box(element_types[t], 1, 1, 1, sb_v3(1, 1, 1), 0);
        sb_domain domain;
        int n = sb_element_node_count(element_types[t]);
        double *k = (double *)calloc((size_t)(9 * n * n), sizeof(double));
        mesh.element_count = 1;
        if (CHECK_OK(sb_domain_create(&mesh, SB_INTEGRATION_STANDARD, 0, NULL, &domain, NULL))) {
            for (int p = 0; p < domain.points_per_cell; p++)
                for (int i = 0; i < 3 * n; i++)
                    for (int j = 0; j < 3 * n; j++) {
                        const sb_real *a = domain.gradients + 3 * (p * n + i / 3);
                        const sb_real *b = domain.gradients + 3 * (p * n + j / 3);
                        double sum = (double)(a[i % 3] * b[j % 3] + a[j % 3] * b[i % 3]); /* lambda = mu = 1 */
                        for (int c = 0; c < 3 && i % 3 == j % 3; c++)
                            sum += (double)(a[c] * b[c]);
                        k[i * 3 * n + j] += (double)domain.weights[p] * sum;
                    }
            CHECK_INT(rank_of(k, 3 * n), 3 * n - 6);
            sb_domain_free(&domain);
        }
        free(k);
        sb_mesh_free(&mesh);
    }
}

/* ---- arguments, regions, supports ---- */

static void test_regions(void)
{
    sb_mesh mesh = scene_box(SB_HEX8, 2, 1, 1, sb_v3(2, 1, 1), 0);
    sb_body_def def = sb_default_body_def();
    sb_region_material stiff;
    int regions[2] = {7, -3};
    sb_material soft = sb_material_linear(REAL(1e3), REAL(0), REAL(1000));
    sb_error error;
    sb_body *body;
    sb_static_options options = sb_default_static_options();
    sb_vec3 target = sb_v3(REAL(0.03), 0, 0), zero = sb_v3(0, 0, 0);
    mesh.regions = regions;
    stiff.region = -3;
    stiff.material = sb_material_linear(REAL(2e3), REAL(0), REAL(500));
    def.mesh = &mesh;
    def.material = soft;
    def.region_materials = &stiff;
    def.region_material_count = 1;
    body = scene_body(&def);
    CHECK_NEAR(sb_body_mass(body), 1500, scene_tolerance(1e-9, 1e4));
    /* two springs in series: the soft half takes two thirds */
    for (int i = 0; i < mesh.node_count; i++) {
        CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_Y | SB_Z));
        if (mesh.nodes[i].x != 1)
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_X, mesh.nodes[i].x > 1 ? &target : &zero, 1));
    }
    options.tolerance = REAL(1e-12);
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].x == 1)
            CHECK_NEAR(sb_body_displacements(body)[i].x, 0.02, scene_tolerance(1e-12, 10));
    CHECK_RESULT(sb_body_set_region_material(body, 5, &soft, &error), SB_ERROR_INDEX);
    CHECK_OK(sb_body_set_region_material(body, -3, &soft, &error));
    CHECK_NEAR(sb_body_mass(body), 2000, scene_tolerance(1e-9, 1e4));
    sb_body_destroy(body);
    stiff.region = 5;
    body = NULL;
    CHECK_RESULT(sb_body_create(&def, &body, &error), SB_ERROR_INDEX);
    CHECK(body == NULL && strstr(error.message, "region 5") != NULL);
    mesh.regions = NULL;
    sb_mesh_free(&mesh);
}

static void test_bad_arguments(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 1, 1, 1, sb_v3(1, 1, 1), 0);
    sb_body_def good = sb_default_body_def(), def;
    sb_error error;
    sb_body *body = NULL;
    int bad_node = mesh.node_count, zero = 0, face[3] = {0, 1, 99}, no_face[3] = {1, 2, 6}, twice[3] = {0, 1, 1},
        thrice[3] = {0, 0, 0};
    sb_vec3 nan_vector = sb_v3(0, REAL(NAN), 0), v = sb_v3(0, 0, 0);
    good.mesh = &mesh;
    good.material = test_material(1);
#define REFUSED(change, result)                                                                                        \
    def = good;                                                                                                        \
    change;                                                                                                            \
    memset(&error, 1, sizeof error);                                                                                   \
    CHECK_RESULT(sb_body_create(&def, &body, &error), result);                                                         \
    CHECK(body == NULL && error.message[0] != 0 && strlen(error.message) < sizeof error.message)
    REFUSED(def.mesh = NULL, SB_ERROR_ARGUMENT);
    REFUSED(def.cookie = 0, SB_ERROR_ARGUMENT);
    REFUSED(def.gravity.x = REAL(INFINITY), SB_ERROR_NOT_FINITE);
    REFUSED(def.damping_mass = -1, SB_ERROR_ARGUMENT);
    check_bad_numbers();
    REFUSED(def.damping_stiffness = REAL(NAN), SB_ERROR_ARGUMENT);
    REFUSED(def.tolerance = 0, SB_ERROR_ARGUMENT);
    REFUSED(def.tolerance = 1, SB_ERROR_ARGUMENT);
    REFUSED(def.max_iterations = 0, SB_ERROR_ARGUMENT);
    REFUSED(def.max_newton = 0, SB_ERROR_ARGUMENT);
    REFUSED(def.newton_tolerance = -1, SB_ERROR_ARGUMENT);
    REFUSED(def.single_rotation = 1, SB_ERROR_ARGUMENT);
    REFUSED(def.integration = (sb_integration)3, SB_ERROR_ARGUMENT);
    REFUSED(def.material.mu = -1, SB_ERROR_MATERIAL);
    REFUSED(def.material.density = 0, SB_ERROR_MATERIAL);
    REFUSED(def.region_material_count = 2, SB_ERROR_ARGUMENT);
#undef REFUSED
    CHECK_RESULT(sb_body_create(NULL, &body, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_create(&good, NULL, NULL), SB_ERROR_ARGUMENT);
    body = scene_body(&good);
    CHECK_RESULT(sb_body_fix_nodes(body, &bad_node, 1, SB_XYZ), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_fix_nodes(body, &zero, -1, SB_XYZ), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_fix_nodes(body, &zero, 1, 8), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_prescribe(body, &zero, 1, SB_X, &nan_vector, 1), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_body_prescribe(body, &zero, 1, SB_X, NULL, 1), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_forces(body, &zero, 1, &nan_vector, 1), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_body_add_traction(body, face, 1, 3, v, &error), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_add_traction(body, no_face, 1, 3, v, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_traction(body, twice, 1, 3, v, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_traction(body, thrice, 1, 3, v, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_add_traction(body, face, 1, 5, v, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_set_gravity(body, nan_vector), SB_ERROR_NOT_FINITE);
    CHECK_RESULT(sb_body_set_damping(body, -1, 0), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_set_solver(body, 2, 10), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_step(body, 0, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_step(body, REAL(NAN), NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_step(NULL, 1, NULL), SB_ERROR_ARGUMENT);
    for (int i = 0; i < mesh.node_count; i++)
        CHECK_INT(sb_body_supports(body)[i], 0);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    sb_body_destroy(NULL);
}

/* Calls on nodes take positions and name what is wrong with which node; the calls without an error do the same. */
static void test_convention(void)
{
    sb_mesh mesh = scene_box(SB_TET10, 2, 2, 2, sb_v3(1, 1, 1), 0.2);
    sb_body_def def = sb_default_body_def();
    sb_body *body, *old;
    sb_error error;
    sb_step_info info;
    sb_vec3 to[2], ways[2], push = sb_v3(1, 0, REAL(-2));
    int nodes[2] = {3, 7}, far[2] = {3, 100000};
    def.mesh = &mesh;
    def.material = test_material(1);
    body = scene_body(&def);
    old = scene_body(&def);
    scene_fix_boundary(body, &mesh);
    scene_fix_boundary(old, &mesh);
    for (int i = 0; i < 2; i++) {
        ways[i] = sb_v3(REAL(0.01), REAL(0.02 * i), REAL(-0.01));
        to[i] = sb_v3_add(sb_body_positions(body)[nodes[i]], ways[i]);
    }
    CHECK_OK(sb_body_place(body, nodes, 2, SB_X | SB_Z, to, &error));
    CHECK_OK(sb_body_prescribe(old, nodes, 2, SB_X | SB_Z, ways, 0));
    CHECK_OK(sb_body_step(body, REAL(0.01), &info));
    CHECK_OK(sb_body_step(old, REAL(0.01), &info));
    for (int i = 0; i < 2; i++) {
        sb_vec3 x = sb_body_positions(body)[nodes[i]];
        CHECK_NEAR(x.x, to[i].x, scene_tolerance(1e-15, 1));
        CHECK_NEAR(x.z, to[i].z, scene_tolerance(1e-15, 1));
    }
    CHECK_NEAR(scene_distance(sb_body_positions(body), sb_body_positions(old), mesh.node_count), 0,
               scene_tolerance(1e-12, 100));
    CHECK_OK(sb_body_release(body, nodes, 2, SB_XYZ, &error));
    CHECK(sb_body_supports(body)[3] == 0 && sb_body_supports(body)[7] == 0);
    CHECK_OK(sb_body_hold(body, nodes, 1, SB_Y, NULL));
    CHECK(sb_body_supports(body)[3] == SB_Y);
    CHECK_OK(sb_body_apply_forces(body, nodes, 2, &push, 1, NULL));

    CHECK_RESULT(sb_body_hold(body, far, 2, SB_XYZ, &error), SB_ERROR_INDEX);
    CHECK(error.node == 100000 && strstr(error.message, "100000"));
    CHECK(sb_body_supports(body)[3] == SB_Y);
    CHECK_RESULT(sb_body_hold(body, nodes, 2, 9, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "axes"));
    to[1].y = (sb_real)NAN;
    CHECK_RESULT(sb_body_place(body, nodes, 2, SB_XYZ, to, &error), SB_ERROR_NOT_FINITE);
    CHECK(error.node == 7 && sb_body_supports(body)[3] == SB_Y);
    CHECK_RESULT(sb_body_place(body, nodes, 2, SB_XYZ, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "positions"));
    CHECK_RESULT(sb_body_release(body, far + 1, 1, SB_XYZ, &error), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_apply_forces(body, nodes, 2, to, 0, &error), SB_ERROR_NOT_FINITE);
    CHECK(error.node == 7);
    CHECK_RESULT(sb_body_apply_forces(NULL, nodes, 2, &push, 1, &error), SB_ERROR_ARGUMENT);
    sb_body_destroy(body);
    sb_body_destroy(old);
    sb_mesh_free(&mesh);
}

static void test_unsupported(void)
{
    /* a hinge leaves one rotation free; one more support removes it */
    sb_mesh mesh = scene_box(SB_TET4, 2, 2, 2, sb_v3(1, 1, 1), 0);
    sb_body_def def = sb_default_body_def();
    sb_check_report report;
    sb_step_info info;
    int tip = mesh.node_count - 1;
    sb_body *body;
    def.mesh = &mesh;
    def.material = test_material(1);
    body = scene_body(&def);
    CHECK_RESULT(sb_body_solve_static(body, NULL, &info), SB_ERROR_UNCONSTRAINED);
    CHECK(info.error.node >= 0 && info.error.message[0] != 0);
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].x == 0 && mesh.nodes[i].y == 0)
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_XYZ));
    CHECK_RESULT(sb_body_solve_static(body, NULL, &info), SB_ERROR_UNCONSTRAINED);
    CHECK_OK(sb_body_check(body, &report));
    CHECK(report.warnings & SB_CHECK_UNSUPPORTED);
    CHECK_OK(sb_body_fix_nodes(body, &tip, 1, SB_X));
    CHECK_OK(sb_body_solve_static(body, NULL, &info));
    CHECK_OK(sb_body_check(body, &report));
    CHECK(!(report.warnings & SB_CHECK_UNSUPPORTED));
    CHECK_OK(sb_body_release_nodes(body, &tip, 1, SB_X));
    CHECK_RESULT(sb_body_solve_static(body, NULL, &info), SB_ERROR_UNCONSTRAINED);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* A clamped beam is supported however slender it is. */
static void test_slender(void)
{
    sb_mesh mesh = scene_box(SB_HEX8, 200, 1, 1, sb_v3(2, REAL(0.01), REAL(0.01)), 0);
    sb_body_def def = sb_default_body_def();
    sb_check_report report;
    sb_body *body;
    def.mesh = &mesh;
    def.material = test_material(1);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_check(body, &report));
    CHECK(!(report.warnings & SB_CHECK_UNSUPPORTED));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_check(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 2, 2, 2, sb_v3(200, 100, 100), 0);
    sb_body_def def = sb_default_body_def();
    sb_check_report report;
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_corotated(REAL(5e-3), REAL(0.495), REAL(1.06e-6));
    body = scene_body(&def);
    CHECK_OK(sb_body_check(body, &report));
    CHECK_INT(report.warnings,
              SB_CHECK_SIZE | SB_CHECK_DENSITY | SB_CHECK_STIFFNESS | SB_CHECK_LOCKING | SB_CHECK_UNSUPPORTED);
    CHECK_NEAR(report.size, sqrt(60000), 1e-3);
    CHECK_INT(report.component_count, 1);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    mesh = scene_box(SB_TET10, 2, 2, 2, sb_v3(REAL(0.2), REAL(0.1), REAL(0.1)), 0);
    def.material = sb_material_corotated(REAL(5e3), REAL(0.495), REAL(1060));
    def.mesh = &mesh;
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_check(body, &report));
    CHECK_INT(report.warnings, 0);
    for (unsigned bit = 1; bit <= SB_CHECK_DUPLICATES; bit <<= 1)
        CHECK(strcmp(sb_check_string(bit), sb_check_string(0)) != 0);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* Two blocks, one of them loose, and a node of no element. */
static void test_parts_and_loose_nodes(void)
{
    sb_vec3 nodes[9] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {5, 5, 5},
                        {3, 0, 0}, {4, 0, 0}, {3, 1, 0}, {3, 0, 1}};
    int elements[8] = {0, 1, 2, 3, 5, 6, 7, 8}, held[4] = {0, 1, 2, 3}, more[3] = {5, 6, 7};
    sb_mesh mesh;
    sb_body_def def = sb_default_body_def();
    sb_check_report report;
    sb_step_info info;
    sb_body *body;
    memset(&mesh, 0, sizeof mesh);
    mesh.node_count = 9;
    mesh.nodes = nodes;
    mesh.element_type = SB_TET4;
    mesh.element_count = 2;
    mesh.elements = elements;
    def.mesh = &mesh;
    def.material = test_material(1);
    def.gravity = sb_v3(0, 0, REAL(-0.1));
    body = scene_body(&def);
    CHECK_OK(sb_body_fix_nodes(body, held, 3, SB_XYZ));
    CHECK_OK(sb_body_check(body, &report));
    CHECK_INT(report.component_count, 2);
    CHECK_INT(report.unreferenced_count, 1);
    CHECK_INT(report.unsupported_component_node, 5);
    CHECK_RESULT(sb_body_solve_static(body, NULL, &info), SB_ERROR_UNCONSTRAINED);
    CHECK_INT(info.error.node, 5);
    CHECK_OK(sb_body_step(body, REAL(0.01), &info)); /* the loose part falls, the loose node stays */
    CHECK_NEAR(sb_body_velocities(body)[5].z, -0.001, 1e-8);
    CHECK_NEAR(sb_body_velocities(body)[4].z, 0, 0);
    CHECK_OK(sb_body_fix_nodes(body, more, 3, SB_XYZ));
    CHECK_OK(sb_body_solve_static(body, NULL, &info));
    sb_body_destroy(body);
}

/* ---- memory ---- */

static sb_result create_and_use(sb_allocator allocator, const sb_mesh *mesh, scene_memory *memory)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_error error;
    int calls, fixed = 0;
    sb_result result;
    def.mesh = mesh;
    def.material = test_material(1);
    def.mass = SB_MASS_CONSISTENT;
    def.integrator = SB_NEWMARK;
    def.damping_stiffness = REAL(0.01);
    def.allocator = allocator;
    result = sb_body_create(&def, &body, &error);
    if (result != SB_OK) {
        CHECK(body == NULL && error.message[0] != 0);
        return result;
    }
    for (int i = 0; i < 4 && result == SB_OK; i++) {
        result = sb_body_fix_nodes(body, &i, 1, SB_XYZ);
        fixed += result == SB_OK;
    }
    if (result == SB_OK) { /* a material whose steps iterate may take memory once */
        sb_material material = test_material(6);
        result = sb_body_set_material(body, &material, &error);
    }
    if (result == SB_OK) { /* steps, solves and readings take no memory */
        sb_energy energy;
        sb_check_report report;
        sb_mat3 stress;
        sb_real values[512];
        calls = memory->calls;
        CHECK(mesh->node_count <= 512 && mesh->element_count <= 512);
        sb_body_von_mises(body, values);
        sb_body_nodal_von_mises(body, values);
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        CHECK_OK(sb_body_solve_static(body, NULL, NULL));
        CHECK_OK(sb_body_energy(body, &energy));
        CHECK_OK(sb_body_stress(body, 0, 0, &stress));
        CHECK_OK(sb_body_check(body, &report));
        CHECK_INT(memory->calls, calls);
    } else {
        int supported = 0;
        CHECK_RESULT(sb_body_step(body, REAL(0.01), NULL), SB_OK);
        for (int i = 0; i < mesh->node_count; i++)
            supported += sb_body_supports(body)[i] != 0;
        CHECK_INT(supported, fixed); /* the call that failed changed nothing */
    }
    sb_body_destroy(body);
    return result;
}

static void test_memory(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        sb_mesh mesh = scene_box(element_types[t], 2, 2, 1, sb_v3(1, 1, 1), 0);
        scene_memory memory = {0, 0, 0, 0};
        int total;
        CHECK_OK(create_and_use(scene_allocator(&memory), &mesh, &memory));
        CHECK_INT(memory.live, 0);
        total = memory.calls;
        CHECK(total > 5);
        for (int n = 1; n <= total; n++) {
            memory.calls = 0;
            memory.fail_at = n;
            CHECK_RESULT(create_and_use(scene_allocator(&memory), &mesh, &memory), SB_ERROR_MEMORY);
            CHECK_INT(memory.live, 0);
        }
        sb_mesh_free(&mesh);
    }
}

CHECK_SUITE(body, {"patch test to 1e-12", test_patch}, {"positions and errors", test_convention},
            {"patch test with curved sides", test_patch_curved}, {"manufactured solution orders", test_manufactured},
            {"reactions balance loads", test_static_balance}, {"quasi Newton", test_quasi_newton},
            {"traction and stress", test_traction_and_stress},
            {"rigid motions cost nothing", test_rigid_motion_is_free}, {"mass, momentum, kinetic energy", test_mass},
            {"regions", test_regions}, {"bad arguments", test_bad_arguments}, {"unsupported bodies", test_unsupported},
            {"slender bodies", test_slender}, {"set-up check", test_check},
            {"parts and loose nodes", test_parts_and_loose_nodes}, {"allocations fail in turn", test_memory},
            {"shares of lumped mass", test_lumped_shares}, {"rank of the stiffness", test_rank});
