/* Beams, bars under torsion and plates against their theories. Theories of slender bodies are approximations:
 * the case names carry the mesh, and the bounds hold both errors. */
#include "verification_scene.h"

static const double young = 1e6, poisson_none = 0;

/* An element with a mesh that suits it, and how far it may be off there; a new element is a row. */
typedef struct resolution {
    const char *element;
    int nx, ny, nz;
    double bound; /* negative: see verify() */
} resolution;

static void name_with_mesh(char *name, size_t size, const char *text, const resolution *r)
{
    snprintf(name, size, "%s, %dx%dx%d", text, r->nx, r->ny, r->nz);
}

static const verify_plane left = {0, 0}, right = {0, 1}; /* ends of beams of length 1 */

/* A beam of length 1 along x with a square section of side h, clamped at x = 0. */
static sb_body *cantilever(sb_mesh *mesh, const resolution *r, double h, sb_material material)
{
    const verify_element *element = verify_element_named(r->element);
    sb_body *body;
    *mesh = verify_box(element->type, r->nx, r->ny, r->nz, 1, h, h);
    body = verify_body(mesh, element, material);
    scene_fix_plane(body, mesh, 0, 0, SB_XYZ);
    return body;
}

static void load_tip(sb_body *body, const sb_mesh *mesh, double h, double px, double pz)
{
    sb_vec3 traction = sb_v3(REAL(px / (h * h)), 0, REAL(pz / (h * h)));
    verify_load(body, mesh, verify_on_plane, &right, verify_uniform, &traction);
}

/* ---- small deflections ---- */

/* Timoshenko's cantilever with Poisson's ratio 0, so that the clamp does not hinder contraction:
 * P L^3/(3 E I) + P L/(k G A), k = 5/6. */
static void test_cantilever(void)
{
    static const resolution meshes[] = {{"tet4", 40, 4, 4, -0.176}, {"tet10", 10, 1, 1, 0.004},
                                        {"hex8", 40, 4, 4, 0.06},   {"hex8, B-bar", 40, 4, 4, 0.06},
                                        {"hex20", 10, 1, 1, 0.003}, {"hex27", 10, 1, 1, 0.003}};
    for (size_t i = 0; i < sizeof meshes / sizeof meshes[0]; i++) {
        static const double h = 0.1, force = 1;
        double inertia = h * h * h * h / 12;
        double expected = force / (3 * young * inertia) + force / (5.0 / 6 * young / 2 * h * h);
        char name[80];
        sb_mesh mesh;
        sb_body *body = cantilever(&mesh, meshes + i, h, sb_material_linear(REAL(young), REAL(poisson_none), 1000));
        load_tip(body, &mesh, h, 0, force);
        verify_solve(body);
        name_with_mesh(name, sizeof name, "cantilever L/h = 10, tip load", meshes + i);
        verify(name, meshes[i].element, "Timoshenko 1921: PL^3/3EI + PL/kGA", "tip deflection (m)", expected,
               (double)verify_mean(body, &mesh, verify_on_plane, &right).z, meshes[i].bound);
        verify_free(body, &mesh);
    }
}

/* A bar bent by the tractions s_xx = c z on its end; z from the middle. The solution is quadratic:
 * u = c/E (x z, -nu y z, -(x^2 + nu (z^2 - y^2))/2). */
static sb_vec3 map_centred(const void *user, double x, double y, double z)
{
    double h = *(const double *)user;
    return sb_v3(REAL(x), REAL(h * (y - 0.5)), REAL(h * (z - 0.5)));
}

static sb_vec3 bending_traction(const void *user, sb_vec3 x, sb_vec3 n)
{
    (void)n;
    return sb_v3(REAL(*(const double *)user) * x.z, 0, 0);
}

static void test_pure_bending(void)
{
    static const resolution meshes[] = {{"tet4", 24, 6, 6, -0.118}, {"tet10", 4, 2, 2, 1e-8},
                                        {"hex8", 24, 6, 6, 0.03},   {"hex8, B-bar", 24, 6, 6, 0.015},
                                        {"hex20", 4, 2, 2, 1e-8},   {"hex27", 4, 2, 2, 1e-8}};
    for (size_t i = 0; i < sizeof meshes / sizeof meshes[0]; i++) {
        static const double h = 0.25, poisson = 0.3, slope = 1e4;
        const resolution *r = meshes + i;
        const verify_element *element = verify_element_named(r->element);
        sb_mesh mesh = verify_block(element->type, r->nx, r->ny, r->nz, map_centred, &h, 1);
        sb_body *body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(poisson), 1000));
        double worst = 0;
        char name[80];
        scene_fix_plane(body, &mesh, 0, 0, SB_X);
        for (int k = 0; k < mesh.node_count; k++) {
            sb_vec3 x = mesh.nodes[k];
            if (x.x == 0 && fabs((double)x.y) < 1e-6 && fabs((double)x.z) < 1e-6)
                CHECK_OK(sb_body_fix_nodes(body, &k, 1, SB_Y | SB_Z));
            else if (x.x == 0 && fabs((double)x.y) < 1e-6 && (double)x.z > 0.49 * h)
                CHECK_OK(sb_body_fix_nodes(body, &k, 1, SB_Y));
        }
        verify_load(body, &mesh, verify_on_plane, &right, bending_traction, &slope);
        verify_solve(body);
        for (int k = 0; k < mesh.node_count; k++) {
            double x = (double)mesh.nodes[k].x, y = (double)mesh.nodes[k].y, z = (double)mesh.nodes[k].z;
            sb_vec3 u = sb_v3(REAL(x * z), REAL(-poisson * y * z), REAL(-0.5 * (x * x + poisson * (z * z - y * y))));
            u = sb_v3_sub(sb_v3_scale(REAL(young / slope), sb_body_displacements(body)[k]), u);
            worst = verify_worse(worst, (double)sb_v3_norm(u) / 0.5);
        }
        name_with_mesh(name, sizeof name, "pure bending", r);
        verify(name, r->element, "Timoshenko and Goodier 1970, sec. 102", "largest error of u/tip deflection", 0, worst,
               r->bound);
        verify_free(body, &mesh);
    }
}

/* ---- large deflections ---- */

/* The elastica of length 1: curvature k' = -a cos(angle), a = P L^2/EI, by Runge-Kutta from the clamp. Leaves
 * the tip in *x, *z and returns the curvature there. */
static double elastica_shoot(double a, double curvature, double *x, double *z)
{
    static const int steps = 2000;
    double state[4] = {0, curvature, 0, 0}, h = 1.0 / steps; /* angle, curvature, x, z */
    for (int s = 0; s < steps; s++) {
        double slope[5][4], sum[4];
        memset(slope, 0, sizeof slope);
        for (int k = 1; k <= 4; k++) {
            double at[4], w = k == 1 ? 0 : k == 4 ? 1 : 0.5;
            for (int i = 0; i < 4; i++)
                at[i] = state[i] + w * h * slope[k - 1][i];
            slope[k][0] = at[1];
            slope[k][1] = -a * cos(at[0]);
            slope[k][2] = cos(at[0]);
            slope[k][3] = sin(at[0]);
        }
        for (int i = 0; i < 4; i++) {
            sum[i] = slope[1][i] + 2 * slope[2][i] + 2 * slope[3][i] + slope[4][i];
            state[i] += h / 6 * sum[i];
        }
    }
    *x = state[2];
    *z = state[3];
    return state[1];
}

static double elastica_end(const void *user, double curvature)
{
    double x, z;
    return elastica_shoot(*(const double *)user, curvature, &x, &z);
}

/* The deflection at a = 2 that Bisshopp and Drucker print: the integration is what they meant. */
static void test_elastica_itself(void)
{
    static const double a = 2;
    double x, z;
    elastica_shoot(a, verify_root(elastica_end, &a, 0, 2 * a), &x, &z);
    CHECK_NEAR(z, 0.4935, 1e-4);
    CHECK_NEAR(1 - x, 0.1606, 1e-4);
}

static void elastica_case(const resolution *r, const verify_material *material, double a)
{
    static const double h = 0.05;
    double inertia = h * h * h * h / 12, x, z;
    char name[80], what[80];
    sb_mesh mesh;
    sb_body *body = cantilever(&mesh, r, h, material->make(REAL(young), REAL(poisson_none), 1000));
    sb_vec3 tip;
    elastica_shoot(a, verify_root(elastica_end, &a, 0, 2 * a), &x, &z);
    load_tip(body, &mesh, h, 0, a * young * inertia);
    verify_solve(body);
    tip = verify_mean(body, &mesh, verify_on_plane, &right);
    snprintf(name, sizeof name, "elastica PL^2/EI = %g, L/h = 20, %dx%dx%d", a, r->nx, r->ny, r->nz);
    snprintf(what, sizeof what, "%s, %s", r->element, material->name);
    verify(name, what, "Bisshopp and Drucker 1945, integrated in the test", "tip deflection/L", z, (double)tip.z,
           r->bound);
    verify(name, what, "Bisshopp and Drucker 1945, integrated in the test", "tip shortening/L", 1 - x, -(double)tip.x,
           2.5 * r->bound);
    verify_free(body, &mesh);
}

static void test_elastica(void)
{
    static const resolution tet10 = {"tet10", 20, 1, 1, 0.005};
    /* strain is linear within an element, which turns by up to 0.06, 0.12 and 0.24 rad here */
    static const resolution single[] = {{"tet10, single rotation", 20, 1, 1, 0.003},
                                        {"tet10, single rotation", 10, 1, 1, 0.003},
                                        {"tet10, single rotation", 5, 1, 1, -0.0336}};
    static const resolution hex[] = {{"hex8", 60, 3, 3, 0.04}, {"hex20", 20, 1, 1, 0.005}, {"hex27", 20, 1, 1, 0.005}};
    for (int m = 0; m < VERIFY_MATERIALS; m++)
        if (!sb_material_is_linear(verify_materials[m].make(1, 0, 1).model))
            elastica_case(&tet10, verify_materials + m, 2);
    elastica_case(&tet10, verify_materials + 1, 1);
    elastica_case(&tet10, verify_materials + 1, 5);
    for (size_t i = 0; i < sizeof single / sizeof single[0]; i++)
        elastica_case(single + i, verify_materials + 1, 2);
    for (size_t i = 0; i < sizeof hex / sizeof hex[0]; i++)
        elastica_case(hex + i, verify_materials + 1, 2);
}

/* A beam rolled up by turning its end along the circle that pure bending gives: M = E I angle/L. Curvature 2
 * pi and h = 0.04 strain the outside by 13 %, hence the corotated model, whose bending is linear. */
static void rolled_case(const resolution *r, double turn, int steps)
{
    static const double h = 0.04;
    double inertia = h * h * h * h / 12;
    char name[80], what[80];
    sb_mesh mesh;
    sb_body *body = cantilever(&mesh, r, h, sb_material_corotated(REAL(young), REAL(poisson_none), 1000));
    sb_vec3 centre, torque;
    for (int s = 1; s <= steps; s++) {
        double angle = turn * s / steps;
        for (int i = 0; i < mesh.node_count; i++) {
            double z = (double)mesh.nodes[i].z - h / 2;
            sb_vec3 u = sb_v3(REAL(sin(angle) / angle - z * sin(angle) - 1), 0,
                              REAL((1 - cos(angle)) / angle + z * cos(angle) - z));
            if (verify_on_plane(&right, mesh.nodes[i]))
                CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u, 1));
        }
        if (!verify_solve(body))
            break;
    }
    centre = sb_v3(REAL(sin(turn) / turn), REAL(h / 2), REAL(h / 2 + (1 - cos(turn)) / turn));
    torque = verify_torque(body, &mesh, verify_on_plane, &right, centre, sb_body_positions(body));
    snprintf(name, sizeof name, "beam bent by %g degrees, L/h = 25, %dx%dx%d", turn * 180 / VERIFY_PI, r->nx, r->ny,
             r->nz);
    snprintf(what, sizeof what, "%s, corotated", r->element);
    verify(name, what, "Euler: M = EI angle/L", "end moment/(EI/L)", turn, -(double)torque.y / (young * inertia),
           r->bound * pow(turn / (1.5 * VERIFY_PI), 2));
    verify_free(body, &mesh);
}

static void test_rolled(void)
{
    static const resolution tet10 = {"tet10", 25, 1, 1, 0.01};
    rolled_case(&tet10, VERIFY_PI / 2, 4);
    rolled_case(&tet10, VERIFY_PI, 8);
    rolled_case(&tet10, 1.5 * VERIFY_PI, 12);
}

/* Lateral tip load Q on a cantilever pressed by half of Euler's load: Q/(P k) (tan kL - kL), k^2 = P/EI. */
static void test_beam_column(void)
{
    static const resolution tet10 = {"tet10", 20, 1, 1, 0.004};
    static const double h = 0.05, share[2] = {0.5, -1};
    for (int i = 0; i < 2; i++) {
        double inertia = h * h * h * h / 12, critical = VERIFY_PI * VERIFY_PI * young * inertia / 4;
        double axial = share[i] * critical, k = sqrt(fabs(axial) / (young * inertia));
        double lateral = 1e-2 * critical; /* a share of the load that a solve in single precision sees */
        double shape = axial > 0 ? tan(k) - k : k - tanh(k);
        char name[80];
        sb_mesh mesh;
        sb_body *body = cantilever(&mesh, &tet10, h, sb_material_corotated(REAL(young), REAL(poisson_none), 1000));
        load_tip(body, &mesh, h, -axial, lateral);
        verify_solve(body);
        snprintf(name, sizeof name, "beam-column at %g of Euler's load, L/h = 20, 20x1x1", share[i]);
        verify(name, "tet10, corotated", "Timoshenko and Gere 1961, ch. 1", "tip deflection (m)",
               lateral / (fabs(axial) * k) * shape, (double)verify_mean(body, &mesh, verify_on_plane, &right).z,
               tet10.bound);
        verify_free(body, &mesh);
    }
}

/* ---- torsion ---- */

/* Turns the ends at x = 0 and x = length, free to warp, by 0 and `angle` (small); returns the torque. */
static double twist(sb_body *body, const sb_mesh *mesh, double length, double cy, double cz, double angle)
{
    verify_plane end = {0, 0};
    int held = 0;
    end.value = length;
    for (int i = 0; i < mesh->node_count; i++) {
        sb_vec3 x = mesh->nodes[i];
        sb_real t = REAL(verify_on_plane(&end, x) ? angle : 0);
        sb_vec3 u = sb_v3(0, t * (REAL(cz) - x.z), t * (x.y - REAL(cy)));
        if (verify_on_plane(&end, x) || verify_on_plane(&left, x))
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_Y | SB_Z, &u, 1));
        if (!held && verify_on_plane(&left, x) && fabs((double)x.y - cy) + fabs((double)x.z - cz) < 1e-6) {
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_X));
            held = 1;
        }
    }
    CHECK(held);
    verify_solve(body);
    return (double)verify_torque(body, mesh, verify_on_plane, &end, sb_v3(0, REAL(cy), REAL(cz)), mesh->nodes).x;
}

/* J/a^4 of a square section: 1/3 - 64/pi^5 sum tanh(n pi/2)/n^5, n odd. */
static double square_torsion(void)
{
    double sum = 0;
    for (int n = 1; n < 40; n += 2)
        sum += tanh(n * VERIFY_PI / 2) / pow(n, 5);
    return 1.0 / 3 - 64 / pow(VERIFY_PI, 5) * sum;
}

static void test_square_torsion(void)
{
    static const resolution meshes[] = {{"tet4", 4, 12, 12, -0.063}, {"tet10", 2, 4, 4, 0.007},
                                        {"hex8", 4, 12, 12, 0.012},  {"hex8, B-bar", 4, 12, 12, 0.012},
                                        {"hex20", 2, 4, 4, 0.003},   {"hex27", 2, 4, 4, 0.003}};
    CHECK_NEAR(square_torsion(), 0.1406, 5e-5);
    for (size_t i = 0; i < sizeof meshes / sizeof meshes[0]; i++) {
        static const double angle = 0.01, length = 0.5, poisson = 0.3;
        const resolution *r = meshes + i;
        const verify_element *element = verify_element_named(r->element);
        sb_mesh mesh = verify_box(element->type, r->nx, r->ny, r->nz, length, 1, 1);
        sb_body *body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(poisson), 1000));
        double shear = young / (2 * (1 + poisson));
        char name[80];
        name_with_mesh(name, sizeof name, "torsion of a square bar", r);
        verify(name, r->element, "Saint-Venant 1855: J = 0.1406 a^4, summed in the test", "torque/(G angle a^4/L)",
               square_torsion(), twist(body, &mesh, length, 0.5, 0.5, angle) / (shear * angle / length), r->bound);
        verify_free(body, &mesh);
    }
}

static void test_round_torsion(void)
{
    static const resolution meshes[] = {{"tet4", 4, 16, 16, -0.0505}, {"tet10", 2, 8, 8, 5e-4},
                                        {"hex8", 4, 16, 16, 0.016},   {"hex8, B-bar", 4, 16, 16, 0.016},
                                        {"hex20", 2, 8, 8, 3e-4},     {"hex27", 2, 8, 8, 3e-4}};
    for (size_t i = 0; i < sizeof meshes / sizeof meshes[0]; i++) {
        static const double angle = 0.01, length = 1, radius = 1, poisson = 0.3;
        const resolution *r = meshes + i;
        const verify_element *element = verify_element_named(r->element);
        sb_mesh mesh;
        sb_body *body;
        double shear = young / (2 * (1 + poisson));
        char name[80];
        if (!CHECK_OK(sb_mesh_cylinder(element->type, 0, REAL(radius), REAL(length), r->ny, r->nx, NULL, &mesh, NULL)))
            continue;
        verify_round(&mesh, radius);
        body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(poisson), 1000));
        snprintf(name, sizeof name, "torsion of a round bar, %d cells across", r->ny);
        verify(name, r->element, "Coulomb 1784: J = pi R^4/2", "torque/(G angle R^4/L)", VERIFY_PI / 2,
               twist(body, &mesh, length, 0, 0, angle) / (shear * angle / length), r->bound);
        verify_free(body, &mesh);
    }
}

/* ---- plates ---- */

/* A clamped disc under its weight: q R^4/(64 D) + q R^2/(4 k G h). */
static void disc_case(const resolution *r)
{
    const verify_element *element = verify_element_named(r->element);
    char name[80];
    static const double radius = 1, h = 0.1, poisson = 0.3, gravity = 10, density = 1000;
    sb_mesh mesh;
    sb_body_def def;
    sb_body *body;
    double q = density * gravity * h, shear = young / (2 * (1 + poisson));
    double stiffness = young * h * h * h / (12 * (1 - poisson * poisson));
    double lowest = 0;
    if (!CHECK_OK(sb_mesh_cylinder(element->type, 0, REAL(radius), REAL(h), r->ny, r->nx, NULL, &mesh, NULL)))
        return;
    verify_round(&mesh, radius);
    def = verify_def(&mesh, element, sb_material_linear(REAL(young), REAL(poisson), REAL(density)));
    def.gravity = sb_v3(REAL(-gravity), 0, 0);
    body = scene_body(&def);
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 x = mesh.nodes[i];
        if ((double)(x.y * x.y + x.z * x.z) > radius * radius * 0.9999)
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_XYZ));
    }
    verify_solve(body);
    for (int i = 0; i < mesh.node_count; i++)
        lowest = fmin(lowest, (double)sb_body_displacements(body)[i].x);
    snprintf(name, sizeof name, "clamped disc R/h = 10, weight, %d cells across", r->ny);
    verify(name, r->element, "Timoshenko and Woinowsky-Krieger 1959: qR^4/64D, shear qR^2/4kGh",
           "sag of the middle (m)",
           q * pow(radius, 4) / (64 * stiffness) + q * radius * radius / (4 * 5.0 / 6 * shear * h), -lowest, r->bound);
    verify_free(body, &mesh);
}

static void test_disc(void)
{
    static const resolution meshes[] = {
        {"tet10", 1, 24, 24, 0.04}, {"hex20", 1, 12, 12, -0.0374}, {"hex27", 1, 12, 12, 0.04}};
    for (size_t i = 0; i < sizeof meshes / sizeof meshes[0]; i++)
        disc_case(meshes + i);
}

/* Navier's series for the middle of a simply supported square plate of side 1: w D/q. */
static double navier(void)
{
    double sum = 0;
    for (int m = 1; m < 80; m += 2)
        for (int n = 1; n < 80; n += 2)
            sum += ((m + n) / 2 % 2 ? 1 : -1) / (m * (double)n * pow((double)(m * m + n * n), 2));
    return 16 / pow(VERIFY_PI, 6) * sum;
}

/* A quarter of the plate, symmetric about x = 0 and y = 0. */
static void plate_case(const resolution *r)
{
    static const double half = 0.5, h = 0.02, poisson = 0.3, q = 1;
    static const verify_plane top = {2, 0.02};
    static const sb_vec3 load = {0, 0, -1};
    const verify_element *element = verify_element_named(r->element);
    char name[80];
    sb_mesh mesh = verify_box(element->type, r->nx, r->ny, r->nz, half, half, h);
    sb_body *body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(poisson), 1000));
    double stiffness = young * h * h * h / (12 * (1 - poisson * poisson));
    scene_fix_plane(body, &mesh, 0, 0, SB_X);
    scene_fix_plane(body, &mesh, 1, 0, SB_Y);
    scene_fix_plane(body, &mesh, 0, half, SB_Y | SB_Z); /* the edge may turn about itself only */
    scene_fix_plane(body, &mesh, 1, half, SB_X | SB_Z);
    verify_load(body, &mesh, verify_on_plane, &top, verify_uniform, &load);
    verify_solve(body);
    name_with_mesh(name, sizeof name, "simply supported plate a/h = 50, quarter", r);
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].x == 0 && mesh.nodes[i].y == 0 && mesh.nodes[i].z == 0)
            verify(name, r->element, "Navier 1820: 0.00406 qa^4/D, summed in the test",
                   "deflection of the middle/(qa^4/D)", navier(),
                   -(double)sb_body_displacements(body)[i].z * stiffness / q, r->bound);
    verify_free(body, &mesh);
}

static void test_square_plate(void)
{
    static const resolution meshes[] = {
        {"tet10", 10, 10, 1, 0.009}, {"hex20", 6, 6, 1, 3e-4}, {"hex27", 6, 6, 1, 1e-4}};
    CHECK_NEAR(navier(), 0.00406, 5e-6);
    for (size_t i = 0; i < sizeof meshes / sizeof meshes[0]; i++)
        if (!SB_REAL_IS_FLOAT || i == 0) /* the others' bounds are below the rounding of so thin a plate */
            plate_case(meshes + i);
}

static void test_table(void) { verify_table("verification_beams"); }

CHECK_SUITE(verification_beams, {"cantilever", test_cantilever}, {"pure bending", test_pure_bending},
            {"elastica of the literature", test_elastica_itself}, {"elastica", test_elastica}, {"rolled", test_rolled},
            {"beam-column", test_beam_column}, {"torsion of a square bar", test_square_torsion},
            {"torsion of a round bar", test_round_torsion}, {"clamped disc", test_disc},
            {"square plate", test_square_plate}, {"table", test_table});
