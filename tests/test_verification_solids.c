/* Solids: thick cylinders and spheres under pressure, holes, columns under their own weight, Cook's membrane,
 * bonded blocks, finite inflation and torsion. Meshes have curved sides where the element has nodes for
 * them. Those of round bodies are graded, and each has an even twin: near Poisson's ratio 1/2 grading hides how
 * quadratic elements lock, which test_verification_locking.c is about. tet4 and hex8 lock here, too; the rows put on
 * record by how much. */
#include "verification_scene.h"

static const double young = 1e4;

typedef struct mesh_choice {
    const char *element;
    int across, around;
    double poisson;
    double bound; /* of displacements and reactions; negative: see verify() */
    double stress_bound;
    double even_bound, even_stress_bound; /* the same on the even twin of a graded mesh */
} mesh_choice;

/* Reference position of an integration point. */
static sb_vec3 point_position(const sb_mesh *mesh, const sb_body *body, int element, int point)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS], shape[SB_MAX_ELEMENT_NODES];
    int nodes = sb_element_node_count(mesh->element_type);
    int count = sb_element_quadrature(mesh->element_type, SB_QUADRATURE_STIFFNESS, points, weights);
    sb_vec3 x = sb_v3(0, 0, 0);
    if (count != sb_body_point_count(body))
        count = sb_element_quadrature(mesh->element_type, SB_QUADRATURE_STIFFNESS_CURVED, points, weights);
    CHECK_INT(count, sb_body_point_count(body));
    sb_element_shape(mesh->element_type, points[point], shape, NULL);
    for (int a = 0; a < nodes; a++)
        x = sb_v3_add(x, sb_v3_scale(shape[a], mesh->nodes[mesh->elements[element * nodes + a]]));
    return x;
}

/* Stress (Pa) that should be at x. */
typedef void (*stress_field)(const void *user, sb_vec3 x, double stress[3][3]);

/* Leaves the deviator of a stress. */
static void deviate(double stress[3][3])
{
    double mean = (stress[0][0] + stress[1][1] + stress[2][2]) / 3;
    for (int i = 0; i < 3; i++)
        stress[i][i] -= mean;
}

/* Root of the mean square over all points of the stress error, relative to that of the stress; of the
 * deviators where pressures of a displacement element mean nothing, at Poisson's ratios near 1/2. */
static double stress_error(const sb_body *body, const sb_mesh *mesh, stress_field field, const void *user,
                           int deviators)
{
    double error = 0, size = 0;
    for (int e = 0; e < mesh->element_count; e++)
        for (int q = 0; q < sb_body_point_count(body); q++) {
            double wanted[3][3], own[3][3], volume = (double)sb_mesh_element_volume(mesh, e);
            sb_mat3 found;
            if (!CHECK_OK(sb_body_stress(body, e, q, &found)))
                return 1;
            for (int k = 0; k < 9; k++)
                own[k / 3][k % 3] = (double)found.m[k / 3][k % 3];
            field(user, point_position(mesh, body, e, q), wanted);
            if (deviators) {
                deviate(wanted);
                deviate(own);
            }
            for (int k = 0; k < 9; k++) {
                double d = own[k / 3][k % 3] - wanted[k / 3][k % 3];
                error += volume * d * d;
                size += volume * wanted[k / 3][k % 3] * wanted[k / 3][k % 3];
            }
        }
    return sqrt(error / size);
}

/* ---- Lame ---- */

typedef struct lame {
    double inner, outer, pressure, poisson;
} lame;

/* Plane strain: s_r, s_a = A -+ B/r^2, s_z = 2 nu A. */
static void cylinder_stress(const void *user, sb_vec3 at, double stress[3][3])
{
    const lame *c = (const lame *)user;
    double a2 = c->inner * c->inner, b2 = c->outer * c->outer, x = (double)at.x, y = (double)at.y;
    double A = c->pressure * a2 / (b2 - a2), B = A * b2, r2 = x * x + y * y, D = B / (r2 * r2);
    memset(stress, 0, 9 * sizeof(double));
    stress[0][0] = A - D * (x * x - y * y);
    stress[1][1] = A + D * (x * x - y * y);
    stress[0][1] = stress[1][0] = -2 * D * x * y;
    stress[2][2] = 2 * c->poisson * A;
}

/* u(a) = (1 + nu) p a/E ((1 - 2 nu) a^2 + b^2)/(b^2 - a^2), plane strain */
static double cylinder_displacement(const lame *c)
{
    double a2 = c->inner * c->inner, b2 = c->outer * c->outer;
    return (1 + c->poisson) * c->pressure * c->inner / young * ((1 - 2 * c->poisson) * a2 + b2) / (b2 - a2);
}

static void hold_everywhere(sb_body *body, int axes)
{
    for (int i = 0; i < sb_body_node_count(body); i++)
        CHECK_OK(sb_body_fix_nodes(body, &i, 1, axes));
}

static void cylinder_case(const mesh_choice *choice, int even)
{
    static const verify_ring ring = {1, 2, VERIFY_PI / 2, 0.1};
    static const char *source = "Lame 1852, plane strain (Timoshenko and Goodier 1970, sec. 28)";
    const verify_element *element = verify_element_named(choice->element);
    lame c = {1, 2, 100, 0};
    sb_mesh mesh = verify_block(element->type, choice->across, choice->around, 1,
                                even ? verify_map_even_ring : verify_map_ring, &ring, 0);
    sb_body *body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(choice->poisson), 1000));
    char name[80];
    c.poisson = choice->poisson;
    verify_hold_symmetry(body, &mesh, 2);
    hold_everywhere(body, SB_Z);
    verify_load(body, &mesh, verify_on_cylinder, &c.inner, verify_pressure, &c.pressure);
    verify_solve(body);
    snprintf(name, sizeof name, "thick cylinder b/a = 2, nu %g, quarter, %dx%d%s", c.poisson, choice->across,
             choice->around, verify_gradings[even]);
    verify(name, choice->element, source, "u(a) (m)", cylinder_displacement(&c),
           verify_outward(body, &mesh, verify_on_cylinder, c.inner), even ? choice->even_bound : choice->bound);
    verify(name, choice->element, source,
           c.poisson > 0.45 ? "deviator error, rms, relative" : "stress error, rms, relative", 0,
           stress_error(body, &mesh, cylinder_stress, &c, c.poisson > 0.45),
           even ? choice->even_stress_bound : choice->stress_bound);
    verify_free(body, &mesh);
}

static void test_cylinder(void)
{
    static const mesh_choice choices[] = {{"tet4", 12, 24, 0.3, 0.008, 0.15, 0.0062, 0.12},
                                          {"tet10", 4, 8, 0.3, 2e-6, 0.0025, 0.0003, 0.028},
                                          {"hex8", 12, 24, 0.3, 0.0025, 0.1, 0.0022, 0.074},
                                          {"hex8, B-bar", 12, 24, 0.3, 0.0017, 0.06, 0.0015, 0.042},
                                          {"hex20", 4, 8, 0.3, 9e-6, 5e-4, 7.9e-5, 0.016},
                                          {"hex27", 4, 8, 0.3, 2e-6, 1.5e-5, 9.3e-5, 0.016},
                                          {"tet4", 12, 24, 0.4999, -0.21, -0.44, -0.243, -0.476},
                                          {"tet10", 4, 8, 0.4999, 5e-4, 0.011, -0.0285, -0.108},
                                          {"hex8", 12, 24, 0.4999, -0.58, -0.58, -0.643, -0.644},
                                          {"hex8, B-bar", 12, 24, 0.4999, 0.0018, 0.06, 0.0016, 0.042},
                                          {"hex20", 4, 8, 0.4999, 1.2e-5, 0.0025, -0.0899, -0.0909},
                                          {"hex27", 4, 8, 0.4999, 1e-6, 4e-5, -0.0899, -0.0908}};
    for (size_t i = 0; i < sizeof choices / sizeof choices[0]; i++)
        if (!SB_REAL_IS_FLOAT || choices[i].poisson < 0.4995) /* else lambda is 5000 mu: strains are rounded by more */
            for (int even = 0; even < 2; even++)
                cylinder_case(choices + i, even);
}

/* s_r = A (1 - b^3/r^3), s_t = A (1 + b^3/(2 r^3)), A = p a^3/(b^3 - a^3) */
static void sphere_stress(const void *user, sb_vec3 at, double stress[3][3])
{
    const lame *c = (const lame *)user;
    const double x[3] = {(double)at.x, (double)at.y, (double)at.z};
    double a3 = pow(c->inner, 3), b3 = pow(c->outer, 3), r2 = x[0] * x[0] + x[1] * x[1] + x[2] * x[2];
    double A = c->pressure * a3 / (b3 - a3), B = A * b3 / pow(r2, 1.5);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            stress[i][j] = (i == j ? A + 0.5 * B : 0) - 1.5 * B * x[i] * x[j] / r2;
}

/* u(a) = p a/E ((1 - 2 nu) a^3 + (1 + nu) b^3/2)/(b^3 - a^3) */
static double sphere_displacement(const lame *c)
{
    double a3 = pow(c->inner, 3), b3 = pow(c->outer, 3);
    return c->pressure * c->inner / young * ((1 - 2 * c->poisson) * a3 + (1 + c->poisson) * b3 / 2) / (b3 - a3);
}

static void sphere_case(const mesh_choice *choice, int even)
{
    static const char *source = "Lame 1852 (Timoshenko and Goodier 1970, sec. 136)";
    const verify_element *element = verify_element_named(choice->element);
    lame c = {1, 2, 100, 0};
    sb_mesh mesh = verify_octant(element->type, c.inner, c.outer, choice->across, choice->around, even);
    sb_body *body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(choice->poisson), 1000));
    char name[80];
    c.poisson = choice->poisson;
    verify_hold_symmetry(body, &mesh, 3);
    verify_load(body, &mesh, verify_on_sphere, &c.inner, verify_pressure, &c.pressure);
    verify_solve(body);
    snprintf(name, sizeof name, "thick sphere b/a = 2, nu %g, octant, 3 of %dx%dx%d%s", c.poisson, choice->across,
             choice->around, choice->around, verify_gradings[even]);
    verify(name, choice->element, source, "u(a) (m)", sphere_displacement(&c),
           verify_outward(body, &mesh, verify_on_sphere, c.inner), even ? choice->even_bound : choice->bound);
    verify(name, choice->element, source,
           c.poisson > 0.45 ? "deviator error, rms, relative" : "stress error, rms, relative", 0,
           stress_error(body, &mesh, sphere_stress, &c, c.poisson > 0.45),
           even ? choice->even_stress_bound : choice->stress_bound);
    verify_free(body, &mesh);
}

static void test_sphere(void)
{
    static const mesh_choice choices[] = {
        {"tet4", 8, 8, 0.3, 0.03, 0.3, 0.029, 0.25},           {"tet10", 3, 3, 0.3, 8e-4, 0.05, 0.004, 0.11},
        {"hex8", 8, 8, 0.3, 0.015, 0.25, 0.014, 0.2},          {"hex8, B-bar", 8, 8, 0.3, 0.009, 0.12, 0.0084, 0.11},
        {"hex20", 3, 3, 0.3, 3e-4, 0.018, 0.0017, 0.068},      {"hex27", 3, 3, 0.3, 9e-5, 0.018, 0.0016, 0.068},
        {"tet4", 8, 8, 0.499, -0.174, -0.377, -0.217, -0.424}, {"tet10", 3, 3, 0.499, 0.007, 0.085, -0.0434, -0.161},
        {"hex8", 8, 8, 0.499, -0.485, -0.489, -0.563, -0.568}, {"hex8, B-bar", 8, 8, 0.499, 0.01, 0.12, 0.009, 0.098},
        {"hex20", 3, 3, 0.499, 0.012, 0.018, -0.144, -0.15},   {"hex27", 3, 3, 0.499, 0.012, 0.018, -0.144, -0.15}};
    for (size_t i = 0; i < sizeof choices / sizeof choices[0]; i++)
        for (int even = 0; even < 2; even++)
            sphere_case(choices + i, even);
}

/* ---- holes ---- */

/* Stress (Pa) along `axis` at the node nearest to x: Hooke's law on the gradients there, mean of its
 * elements. */
static double nodal_stress(const sb_body *body, const sb_mesh *mesh, sb_vec3 x, int axis, double poisson)
{
    verify_constants c = verify_constants_of(young, poisson);
    int nodes = sb_element_node_count(mesh->element_type), node = 0, count = 0;
    double sum = 0;
    for (int i = 0; i < mesh->node_count; i++)
        if (sb_v3_norm(sb_v3_sub(mesh->nodes[i], x)) < sb_v3_norm(sb_v3_sub(mesh->nodes[node], x)))
            node = i;
    for (int i = 0; i < mesh->element_count * nodes; i++) {
        const int *element = mesh->elements + i - i % nodes;
        sb_real xi[3], gradient[SB_MAX_ELEMENT_NODES][3];
        sb_mat3 shape = sb_m3_zero(), change = shape, strain;
        if (mesh->elements[i] != node)
            continue;
        sb_element_node_point(mesh->element_type, i % nodes, xi);
        sb_element_shape(mesh->element_type, xi, NULL, gradient);
        for (int a = 0; a < nodes; a++) {
            sb_vec3 g = sb_v3(gradient[a][0], gradient[a][1], gradient[a][2]);
            shape = sb_m3_add(shape, sb_m3_outer(mesh->nodes[element[a]], g));
            change = sb_m3_add(change, sb_m3_outer(sb_body_displacements(body)[element[a]], g));
        }
        strain = sb_m3_mul(change, sb_m3_inverse(shape));
        sum += c.lambda * (double)sb_m3_trace(strain) + 2 * c.mu * (double)strain.m[axis][axis];
        count++;
    }
    CHECK(count > 0);
    return sum / count;
}

/* Kirsch's plate with a hole of radius 1 under the tension S along x. */
static void kirsch_stress(const void *user, sb_vec3 at, double stress[3][3])
{
    const lame *c = (const lame *)user; /* pressure: S */
    double x = (double)at.x, y = (double)at.y, r2 = 1 / (x * x + y * y), angle = atan2(y, x), half = c->pressure / 2;
    double radial = half * (1 - r2) + half * (1 - 4 * r2 + 3 * r2 * r2) * cos(2 * angle);
    double hoop = half * (1 + r2) - half * (1 + 3 * r2 * r2) * cos(2 * angle);
    double shear = -half * (1 + 2 * r2 - 3 * r2 * r2) * sin(2 * angle), k = cos(angle), s = sin(angle);
    memset(stress, 0, 9 * sizeof(double));
    stress[0][0] = radial * k * k + hoop * s * s - 2 * shear * k * s;
    stress[1][1] = radial * s * s + hoop * k * k + 2 * shear * k * s;
    stress[0][1] = stress[1][0] = (radial - hoop) * k * s + shear * (k * k - s * s);
    stress[2][2] = c->poisson * (radial + hoop);
}

static sb_vec3 kirsch_traction(const void *user, sb_vec3 x, sb_vec3 n)
{
    double stress[3][3], t[3];
    kirsch_stress(user, x, stress);
    for (int i = 0; i < 3; i++)
        t[i] = stress[i][0] * (double)n.x + stress[i][1] * (double)n.y;
    return sb_v3(REAL(t[0]), REAL(t[1]), REAL(t[2]));
}

static void kirsch_case(const mesh_choice *choice, int even)
{
    static const verify_ring ring = {1, 5, VERIFY_PI / 2, 0.1};
    static const verify_plane x_axis = {1, 0};
    static const char *source = "Kirsch 1898, plane strain, exact tractions at r = 5a";
    const verify_element *element = verify_element_named(choice->element);
    lame c = {1, 5, 100, 0.3};
    sb_mesh mesh = verify_block(element->type, choice->across, choice->around, 1,
                                even ? verify_map_even_ring : verify_map_ring, &ring, 0);
    sb_body *body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(c.poisson), 1000));
    double edge = 0;
    char name[80];
    verify_hold_symmetry(body, &mesh, 2);
    hold_everywhere(body, SB_Z);
    verify_load(body, &mesh, verify_on_cylinder, &c.outer, kirsch_traction, &c);
    verify_solve(body);
    for (int k = 0; k < mesh.node_count; k++)
        if (verify_on_plane(&x_axis, mesh.nodes[k]) && fabs((double)mesh.nodes[k].x - 1) < 1e-6)
            edge = (double)sb_body_displacements(body)[k].x;
    snprintf(name, sizeof name, "plate with a round hole, quarter, %dx%d%s", choice->across, choice->around,
             verify_gradings[even]);
    verify(name, choice->element, source, "u at the hole: 3 S a (1 - nu^2)/E (m)",
           3 * c.pressure * (1 - c.poisson * c.poisson) / young, edge, even ? choice->even_bound : choice->bound);
    verify(name, choice->element, source, "stress error, rms, relative", 0,
           stress_error(body, &mesh, kirsch_stress, &c, 0), even ? choice->even_stress_bound : choice->stress_bound);
    verify_free(body, &mesh);
}

static void test_kirsch(void)
{
    static const mesh_choice choices[] = {
        {"tet4", 16, 24, 0.3, 0.018, 0.09, 0.038, 0.096}, {"tet10", 6, 8, 0.3, 0.0017, 0.04, 0.0053, 0.11},
        {"hex8", 16, 24, 0.3, 0.009, 0.05, 0.017, 0.056}, {"hex8, B-bar", 16, 24, 0.3, 0.006, 0.04, 0.011, 0.044},
        {"hex20", 6, 8, 0.3, 8e-4, 0.013, 0.0081, 0.04},  {"hex27", 6, 8, 0.3, 5e-4, 0.012, 0.007, 0.039}};
    for (size_t i = 0; i < sizeof choices / sizeof choices[0]; i++)
        for (int even = 0; even < 2; even++)
            kirsch_case(choices + i, even);
}

/* user: a tension along z (Pa). */
static sb_vec3 axial_traction(const void *user, sb_vec3 x, sb_vec3 n)
{
    (void)x;
    return sb_v3(0, 0, REAL(*(const double *)user) * n.z);
}

static void goodier_case(const mesh_choice *choice, int even)
{
    static const double inner = 1, outer = 10, tension = 100;
    const verify_element *element = verify_element_named(choice->element);
    double poisson = choice->poisson;
    char name[80];
    sb_mesh mesh = verify_octant(element->type, inner, outer, choice->across, choice->around, even);
    sb_body *body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(poisson), 1000));
    verify_hold_symmetry(body, &mesh, 3);
    verify_load(body, &mesh, verify_on_sphere, &outer, axial_traction, &tension);
    verify_solve(body);
    snprintf(name, sizeof name, "spherical hole in a ball of 10 radii, octant, 3 of %dx%dx%d%s", choice->across,
             choice->around, choice->around, verify_gradings[even]);
    verify(name, choice->element, "Goodier 1933: (27 - 15 nu)/(14 - 10 nu)", "stress concentration at the equator",
           (27 - 15 * poisson) / (14 - 10 * poisson), nodal_stress(body, &mesh, sb_v3(1, 0, 0), 2, poisson) / tension,
           even ? choice->even_stress_bound : choice->stress_bound);
    verify_free(body, &mesh);
}

static void test_goodier(void)
{
    static const mesh_choice choices[] = {{"tet10", 8, 5, 0.3, 0, 0.08, 0, 0.29},
                                          {"hex20", 6, 3, 0.3, 0, 0.05, 0, 0.053},
                                          {"hex27", 6, 3, 0.3, 0, 0.06, 0, 0.034}};
    for (size_t i = 0; i < sizeof choices / sizeof choices[0]; i++)
        for (int even = 0; even < 2; even++)
            goodier_case(choices + i, even);
}

/* ---- columns under their own weight ---- */

/* A confined column: u(L) = -rho g L^2/(2 (lambda + 2 mu)). */
static void test_confined_column(void)
{
    static const double length = 1, density = 1000, gravity = 1, poisson = 0.3, bounds[] = {6e-4, 1e-8};
    verify_constants c = verify_constants_of(young, poisson);
    for (int e = 0; e < VERIFY_ELEMENTS; e++) {
        static const verify_plane top = {2, 1};
        const verify_element *element = verify_elements + e;
        sb_mesh mesh;
        sb_body_def def;
        sb_body *body;
        if (!verify_suits(element, SB_LINEAR))
            continue;
        mesh = verify_box(element->type, 1, 1, 8, 0.125, 0.125, length);
        def = verify_def(&mesh, element, sb_material_linear(REAL(young), REAL(poisson), REAL(density)));
        def.gravity = sb_v3(0, 0, REAL(-gravity));
        body = scene_body(&def);
        hold_everywhere(body, SB_X | SB_Y);
        scene_fix_plane(body, &mesh, 2, 0, SB_Z);
        verify_solve(body);
        verify("confined column under its weight, 1x1x8", element->name, "-rho g L^2/(2 (lambda + 2 mu))",
               "sag of the top (m)", -density * gravity * length * length / (2 * (c.lambda + 2 * c.mu)),
               (double)verify_mean(body, &mesh, verify_on_plane, &top).z, bounds[element->type != SB_TET4]);
        verify_free(body, &mesh);
    }
}

/* A hanging bar, pulled by the uniform traction rho g L at its top: w = rho g/(2E) (z^2 - L^2 + nu (x^2 +
 * y^2)). */
static void test_hanging_bar(void)
{
    static const double length = 1, density = 1000, gravity = 1, poisson = 0.3;
    for (int e = 0; e < VERIFY_ELEMENTS; e++) {
        static const verify_plane top = {2, 1};
        const verify_element *element = verify_elements + e;
        double strain = density * gravity / young, worst = 0;
        sb_vec3 pull = sb_v3(0, 0, REAL(density * gravity * length));
        sb_mesh mesh;
        sb_body_def def;
        sb_body *body;
        if (!verify_suits(element, SB_LINEAR))
            continue;
        mesh = verify_box(element->type, 2, 2, 8, 0.25, 0.25, length);
        def = verify_def(&mesh, element, sb_material_linear(REAL(young), REAL(poisson), REAL(density)));
        def.gravity = sb_v3(0, 0, REAL(-gravity));
        body = scene_body(&def);
        verify_hold_symmetry(body, &mesh, 2);
        for (int i = 0; i < mesh.node_count; i++)
            if (mesh.nodes[i].x == 0 && mesh.nodes[i].y == 0 && verify_on_plane(&top, mesh.nodes[i]))
                CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_Z));
        verify_load(body, &mesh, verify_on_plane, &top, verify_uniform, &pull);
        verify_solve(body);
        for (int i = 0; i < mesh.node_count; i++) {
            double x = (double)mesh.nodes[i].x, y = (double)mesh.nodes[i].y, z = (double)mesh.nodes[i].z;
            sb_vec3 u = sb_v3(REAL(-poisson * x * z), REAL(-poisson * y * z),
                              REAL(0.5 * (z * z - length * length + poisson * (x * x + y * y))));
            u = sb_v3_sub(sb_v3_scale(REAL(1 / strain), sb_body_displacements(body)[i]), u);
            worst = verify_worse(worst, (double)sb_v3_norm(u) / 0.5);
        }
        verify("hanging bar under its weight, quarter, 2x2x8", element->name, "Timoshenko and Goodier 1970, sec. 96",
               "largest error of u/stretch", 0, worst,
               element->degree > 1        ? 1e-8
               : element->type == SB_TET4 ? 0.09
                                          : 0.02);
        verify_free(body, &mesh);
    }
}

typedef struct pressed {
    const verify_material *material;
    double poisson, stress;
} pressed;

static double pressed_error(const void *user, double stretch)
{
    const pressed *p = (const pressed *)user;
    double l[3] = {1, 1, stretch}, stress[3];
    p->material->principal(verify_constants_of(young, p->poisson), l, stress);
    return stress[2] - p->stress;
}

/* A confined column that its weight presses to some 0.85 of its height at the bottom (svk has no equilibrium
 * under 1/sqrt(3)): P(l(Z)) = -rho g (L - Z), and the top sinks by the integral of l - 1. */
static void test_soft_column(void)
{
    static const double length = 1, density = 1000, gravity = 2, poisson = 0.3;
    static const verify_plane top = {2, 1};
    static const int cells = 8, steps = 100;
    const verify_element *element = verify_element_named("tet10");
    for (int m = 0; m < VERIFY_MATERIALS; m++) {
        sb_mesh mesh = verify_box(element->type, 1, 1, cells, 0.125, 0.125, length);
        sb_body_def def =
            verify_def(&mesh, element, verify_materials[m].make(REAL(young), REAL(poisson), REAL(density)));
        sb_body *body;
        double sag = 0;
        for (int s = 0; s <= steps; s++) { /* Simpson's rule */
            pressed p;
            double weight = s == 0 || s == steps ? 1 : s % 2 ? 4 : 2;
            p.material = verify_materials + m;
            p.poisson = poisson;
            p.stress = -density * gravity * length * (1 - (double)s / steps);
            sag += weight * (verify_root(pressed_error, &p, 0.6, 1.1) - 1) * length / (3 * steps);
        }
        def.gravity = sb_v3(0, 0, REAL(-gravity));
        body = scene_body(&def);
        hold_everywhere(body, SB_X | SB_Y);
        scene_fix_plane(body, &mesh, 2, 0, SB_Z);
        verify_solve(body);
        char what[80];
        snprintf(what, sizeof what, "tet10, %s", verify_materials[m].name);
        verify("soft confined column under its weight, 1x1x8", what, "P(l) = -rho g (L - Z), integrated in the test",
               "sag of the top (m)", sag, (double)verify_mean(body, &mesh, verify_on_plane, &top).z, 1.5e-5);
        verify_free(body, &mesh);
    }
}

/* ---- Cook ---- */

static sb_vec3 map_cook(const void *user, double x, double y, double z)
{
    return sb_v3(REAL(48 * x), REAL(44 * x + y * (44 - 28 * x)), REAL(*(const double *)user * z));
}

/* Plane stress with E = 1, nu = 1/3 is plane strain with E (1 + 2 nu)/(1 + nu)^2 = 15/16 and nu/(1 + nu) =
 * 1/4. */
static void test_cook(void)
{
    static const mesh_choice choices[] = {
        {"tet4", 32, 32, 0.25, 0.06, 0, 0, 0},   {"tet10", 4, 4, 0.25, 0.036, 0, 0, 0},
        {"tet10", 12, 12, 0.25, 0.004, 0, 0, 0}, {"hex8", 8, 8, 0.25, -0.0785, 0, 0, 0},
        {"hex8", 32, 32, 0.25, 0.012, 0, 0, 0},  {"hex8, B-bar", 32, 32, 0.25, 0.009, 0, 0, 0},
        {"hex20", 4, 4, 0.25, 0.025, 0, 0, 0},   {"hex20", 12, 12, 0.25, 0.004, 0, 0, 0},
        {"hex27", 4, 4, 0.25, 0.011, 0, 0, 0},   {"hex27", 12, 12, 0.25, 0.0016, 0, 0, 0}};
    for (size_t i = 0; i < sizeof choices / sizeof choices[0]; i++) {
        static const verify_plane right = {0, 48};
        const mesh_choice *choice = choices + i;
        const verify_element *element = verify_element_named(choice->element);
        sb_vec3 traction = sb_v3(0, REAL(1.0 / 16), 0);
        double thickness = 48.0 / choice->across, tip = 0;
        sb_mesh mesh = verify_block(element->type, choice->across, choice->around, 1, map_cook, &thickness, 1);
        sb_body *body = verify_body(&mesh, element, sb_material_linear(REAL(15.0 / 16), REAL(0.25), 1000));
        char name[80];
        hold_everywhere(body, SB_Z);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        verify_load(body, &mesh, verify_on_plane, &right, verify_uniform, &traction);
        verify_solve(body);
        for (int k = 0; k < mesh.node_count; k++)
            if (verify_on_plane(&right, mesh.nodes[k]) && fabs((double)mesh.nodes[k].y - 52) < 1e-4)
                tip = (double)sb_body_displacements(body)[k].y;
        snprintf(name, sizeof name, "Cook's membrane, %dx%d", choice->across, choice->around);
        verify(name, choice->element, "Cook 1974; 23.96 of fine meshes in the literature", "tip deflection", 23.96, tip,
               choice->bound);
        verify_free(body, &mesh);
    }
}

/* ---- nearly incompressible ---- */

/* A disc bonded to plates: E (1 + 2 S^2), S = R/(2h), with the bulk modulus in series. What the theory leaves
 * out is the same for all elements; the rest of the errors is locking (B-bar hex8 have none). */
static void bonded_case(const mesh_choice *choice)
{
    static const double radius = 1, h = 0.5, strain = 1e-3;
    const verify_element *element = verify_element_named(choice->element);
    double poisson = choice->poisson;
    char name[80];
    verify_plane end = {0, 0.5};
    verify_constants c = verify_constants_of(young, poisson);
    double shape = radius / (2 * h), apparent = young * (1 + 2 * shape * shape), force;
    sb_mesh mesh;
    sb_body *body;
    if (!CHECK_OK(sb_mesh_cylinder(element->type, 0, REAL(radius), REAL(h), choice->around, choice->across, NULL, &mesh,
                                   NULL)))
        return;
    verify_round(&mesh, radius);
    body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(poisson), 1000));
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    verify_move(body, &mesh, verify_on_plane, &end, SB_XYZ, sb_v3(REAL(-strain * h), 0, 0));
    verify_solve(body);
    force = -(double)verify_reaction(body, &mesh, verify_on_plane, &end).x;
    snprintf(name, sizeof name, "bonded disc R/h = 2, nu %g, %d cells across, %d high", poisson, choice->around,
             choice->across);
    verify(name, choice->element, "Gent and Lindley 1959: E (1 + 2 S^2), approximate", "apparent modulus/E",
           1 / (1 / apparent + 1 / c.bulk) / young, force / (VERIFY_PI * radius * radius * strain) / young,
           choice->bound);
    verify_free(body, &mesh);
}

static void test_bonded_disc(void)
{
    static const mesh_choice choices[] = {
        {"tet4", 6, 14, 0.499, -1.73, 0, 0, 0},   {"tet10", 4, 10, 0.499, -0.0617, 0, 0, 0},
        {"hex8", 6, 14, 0.499, -1.59, 0, 0, 0},   {"hex8, B-bar", 6, 14, 0.499, 0.06, 0, 0, 0},
        {"hex20", 4, 10, 0.499, -0.079, 0, 0, 0}, {"hex27", 4, 10, 0.499, -0.0786, 0, 0, 0}};
    for (size_t i = 0; i < sizeof choices / sizeof choices[0]; i++)
        bonded_case(choices + i);
}

/* Moves the inner surface of an octant out to `stretch` times its radius; returns the radial force on the
 * octant. */
static double inflate(sb_body *body, const sb_mesh *mesh, double inner, double stretch)
{
    double force = 0;
    verify_hold_symmetry(body, mesh, 3);
    for (int i = 0; i < mesh->node_count; i++) {
        sb_vec3 u = sb_v3_scale(REAL(stretch - 1), mesh->nodes[i]);
        if (verify_on_sphere(&inner, mesh->nodes[i]))
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u, 1));
    }
    verify_solve(body);
    for (int i = 0; i < mesh->node_count; i++)
        if (verify_on_sphere(&inner, mesh->nodes[i]))
            force += (double)sb_v3_dot(sb_body_reactions(body)[i], mesh->nodes[i]) / inner;
    return force;
}

/* Incompressible: p = mu (1/(2 lb^4) + 2/lb - 1/(2 la^4) - 2/la), lb from r^3 - R^3 = const. */
static void balloon_case(const mesh_choice *choice, int even)
{
    static const double inner = 1, outer = 2, stretch = 1.5;
    const verify_element *element = verify_element_named(choice->element);
    double poisson = choice->poisson;
    char name[80], what[80];
    sb_mesh mesh = verify_octant(element->type, inner, outer, choice->across, choice->around, even);
    sb_body *body = verify_body(&mesh, element, verify_make_isochoric(REAL(young), REAL(poisson), 1000));
    double mu = verify_constants_of(young, poisson).mu;
    double far = pow(1 + (pow(stretch, 3) - 1) * pow(inner / outer, 3), 1.0 / 3);
    double expected = 1 / (2 * pow(far, 4)) + 2 / far - 1 / (2 * pow(stretch, 4)) - 2 / stretch;
    double area = VERIFY_PI / 2 * pow(inner * stretch, 2);
    snprintf(name, sizeof name, "thick sphere b/a = 2 inflated to 1.5 a, nu %g, octant, 3 of %dx%dx%d%s", poisson,
             choice->across, choice->around, choice->around, verify_gradings[even]);
    snprintf(what, sizeof what, "%s, neo_hookean_isochoric", choice->element);
    verify(name, what, "Green and Zerna 1954, sec. 3.10 (incompressible)", "pressure/mu", expected,
           inflate(body, &mesh, inner, stretch) / (area * mu), even ? choice->even_bound : choice->bound);
    verify_free(body, &mesh);
}

static void test_balloon(void)
{
    static const mesh_choice choices[] = {{"tet10", 4, 4, 0.499, 0.002, 0, 0.0014, 0},
                                          {"hex8", 6, 6, 0.499, -0.738, 0, -0.761, 0},
                                          {"hex8, B-bar", 6, 6, 0.499, 0.012, 0, 0.0091, 0},
                                          {"hex20", 3, 3, 0.499, 0.023, 0, 0.0065, 0},
                                          {"hex27", 3, 3, 0.499, 0.023, 0, 0.0062, 0}};
    for (size_t i = 0; i < sizeof choices / sizeof choices[0]; i++)
        for (int even = 0; even < 2; even++)
            balloon_case(choices + i, even);
}

/* ---- finite inflation of compressible spheres ---- */

static void inflation_case(const verify_material *material, int even)
{
    static const double inner = 1, outer = 2, stretch = 1.1, poisson = 0.3;
    static const double bounds[2][2] = {{3e-4, 0.002}, {0.0017, 0.008}};
    const verify_element *element = verify_element_named("tet10");
    sb_mesh mesh = verify_octant(element->type, inner, outer, 3, 2, even);
    sb_body *body = verify_body(&mesh, element, material->make(REAL(young), REAL(poisson), 1000));
    char name[80], what[80];
    double force = verify_inflation_pressure(material, young, poisson, stretch) * stretch * stretch * VERIFY_PI / 2;
    snprintf(name, sizeof name, "thick sphere b/a = 2 inflated to 1.1 a, nu 0.3, octant, 3 of 3x2x2%s",
             verify_gradings[even]);
    snprintf(what, sizeof what, "tet10, %s", material->name);
    verify(name, what, "d(R^2 P_r)/dR = 2 R P_t (Ogden 1997), integrated in the test", "radial force on the octant (N)",
           force, inflate(body, &mesh, inner, stretch), bounds[even][material->principal == verify_svk]);
    verify_free(body, &mesh);
}

static void test_inflation(void)
{
    for (int m = 0; m < VERIFY_MATERIALS; m++)
        for (int even = 0; even < 2; even++)
            inflation_case(verify_materials + m, even);
}

/* ---- finite torsion ---- */

/* Ends turned, not moved: T = pi mu psi R^4/2 and the thrust -pi mu psi^2 R^4/4 of the Poynting effect. */
static void rivlin_case(const mesh_choice *choice)
{
    static const double radius = 1, length = 1, twist = 0.5;
    const verify_element *element = verify_element_named(choice->element);
    double poisson = choice->poisson;
    char name[80], what[80];
    verify_plane left = {0, 0}, right = {0, 1};
    double mu = verify_constants_of(young, poisson).mu;
    sb_mesh mesh;
    sb_body *body;
    sb_vec3 origin = sb_v3(0, 0, 0);
    if (!CHECK_OK(sb_mesh_cylinder(element->type, 0, REAL(radius), REAL(length), choice->around, choice->across, NULL,
                                   &mesh, NULL)))
        return;
    verify_round(&mesh, radius);
    body = verify_body(&mesh, element, verify_make_isochoric(REAL(young), REAL(poisson), 1000));
    verify_move(body, &mesh, verify_on_plane, &left, SB_XYZ, origin);
    for (int i = 0; i < mesh.node_count; i++) {
        double c = cos(twist) - 1, s = sin(twist), y = (double)mesh.nodes[i].y, z = (double)mesh.nodes[i].z;
        sb_vec3 u = sb_v3(0, REAL(c * y - s * z), REAL(s * y + c * z));
        if (verify_on_plane(&right, mesh.nodes[i]))
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u, 1));
    }
    verify_solve(body);
    snprintf(name, sizeof name, "cylinder twisted by 0.5 rad per radius, nu %g, %d cells across", poisson,
             choice->around);
    snprintf(what, sizeof what, "%s, neo_hookean_isochoric", choice->element);
    verify(name, what, "Rivlin 1949 (incompressible)", "torque/(mu R^3)", VERIFY_PI * twist / 2,
           (double)verify_torque(body, &mesh, verify_on_plane, &right, origin, sb_body_positions(body)).x / mu,
           choice->bound);
    verify(name, what, "Rivlin 1949 (incompressible), Poynting effect", "axial force/(mu R^2)",
           -VERIFY_PI * twist * twist / 4, (double)verify_reaction(body, &mesh, verify_on_plane, &right).x / mu,
           choice->stress_bound);
    verify_free(body, &mesh);
}

static void test_rivlin(void)
{
    static const mesh_choice choices[] = {{"tet10", 4, 8, 0.49, 0.0015, 0.045, 0, 0},
                                          {"hex8, B-bar", 6, 14, 0.49, 0.025, 0.03, 0, 0},
                                          {"hex20", 2, 6, 0.49, 0.0025, 0.06, 0, 0},
                                          {"hex27", 2, 6, 0.49, 0.0025, 0.06, 0, 0}};
    for (size_t i = 0; i < sizeof choices / sizeof choices[0]; i++)
        rivlin_case(choices + i);
}

static void test_table(void) { verify_table("verification_solids"); }

CHECK_SUITE(verification_solids, {"thick cylinder", test_cylinder}, {"thick sphere", test_sphere},
            {"plate with a hole", test_kirsch}, {"spherical hole", test_goodier},
            {"confined column", test_confined_column}, {"hanging bar", test_hanging_bar},
            {"soft column", test_soft_column}, {"Cook's membrane", test_cook}, {"bonded disc", test_bonded_disc},
            {"incompressible balloon", test_balloon}, {"inflated spheres", test_inflation},
            {"finite torsion", test_rivlin}, {"table", test_table});
