/* Derivatives of equilibria, and what is identified from readings, against closed forms: states whose displacements the
 * elements have exactly, so that what is left is the derivatives' own error. */
#include "verification_scene.h"

static const double young = 5e3, poisson = 0.4;

static sb_mesh distorted_cube(const verify_element *element)
{
    static const double amplitude = 0.05;
    return verify_block(element->type, 2, 2, 2, verify_map_distorted, &amplitude, 1);
}

static sb_parameter by(sb_parameter_kind kind)
{
    sb_parameter p;
    memset(&p, 0, sizeof p);
    p.kind = kind;
    return p;
}

/* To what derivatives ask for: closer than verify_solve in float. */
static void solve(sb_body *body)
{
    sb_static_options options = sb_default_static_options();
    options.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-12);
    options.forces_only = 1;
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
}

/* ---- a cube stretched along x ---- */

typedef struct stretched {
    const verify_material *material;
    double young, poisson, stretch;
} stretched;

static double side_stress(const void *user, double q)
{
    const stretched *s = (const stretched *)user;
    const double l[3] = {s->stretch, q, q};
    double stress[3];
    s->material->principal(verify_constants_of(s->young, s->poisson), l, stress);
    return stress[2];
}

/* Force on a face of 1 m^2. */
static double closed_force(const verify_material *material, double e, double nu, double stretch)
{
    const stretched s = {material, e, nu, stretch};
    double q = verify_root(side_stress, &s, 0.6, 1.4), stress[3];
    const double l[3] = {stretch, q, q};
    material->principal(verify_constants_of(e, nu), l, stress);
    return stress[0];
}

/* Slope of a function of one number, to a power of h that leaves its rounding. */
static double slope(double (*f)(const verify_material *, double), const verify_material *material, double at)
{
    const double h = 1e-3;
    return (8 * (f(material, at + h) - f(material, at - h)) - f(material, at + 2 * h) + f(material, at - 2 * h)) /
           (12 * h);
}

static double force_by_poisson(const verify_material *m, double nu) { return closed_force(m, young, nu, 1.3); }
static double force_by_stretch(const verify_material *m, double l) { return closed_force(m, young, poisson, l); }

static void test_stretched(void)
{
    static const char *const source = "Ogden 1997, P_2 = P_3 = 0";
    for (int k = 0; k < VERIFY_MATERIALS; k++) {
        static const char *const names[5] = {"tet4", "tet10", "hex8", "hex20", "hex27"};
        const verify_material *material = verify_materials + k;
        const verify_element *element = verify_element_named(names[k % 5]);
        const verify_plane end = {0, 1};
        sb_parameter p[3] = {by(SB_PARAMETER_YOUNG), by(SB_PARAMETER_POISSON), by(SB_PARAMETER_SUPPORT)};
        sb_mesh mesh = distorted_cube(element);
        sb_body *body = verify_body(&mesh, element, material->make(REAL(young), REAL(poisson), 1000));
        int n = mesh.node_count, count = 0, *nodes = (int *)malloc((size_t)n * sizeof(int));
        double found[3] = {0, 0, 0}, sideways = slope(force_by_poisson, material, poisson) / young;
        sb_vec3 *du = (sb_vec3 *)malloc(6 * (size_t)n * sizeof *du), *dr = du + 3 * n;
        char what[96];
        verify_hold_symmetry(body, &mesh, 3);
        verify_move(body, &mesh, verify_on_plane, &end, SB_X, sb_v3(REAL(0.3), 0, 0));
        for (int i = 0; i < n; i++)
            if (verify_on_plane(&end, mesh.nodes[i]))
                nodes[count++] = i;
        p[2].nodes = nodes, p[2].node_count = count;
        solve(body);
        CHECK_OK(sb_body_sensitivities(body, p, 3, du, dr, NULL));
        for (int j = 0; j < 3; j++)
            for (int i = 0; i < count; i++)
                found[j] += (double)dr[j * n + nodes[i]].x;
        snprintf(what, sizeof what, "%s, %s", names[k % 5], material->name);
        verify("cube stretched to 1.3", what, source, "dF/dE (m^2)",
               closed_force(material, young, poisson, 1.3) / young, found[0], 1e-8);
        verify("cube stretched to 1.3", what, source, "dF/dnu / E (m^2)", fabs(sideways) < 1e-9 ? 0 : sideways,
               found[1] / young, 1e-6);
        verify("cube stretched to 1.3", what, source, "dF/d(place of the end) (N/m)",
               slope(force_by_stretch, material, 1.3), found[2], 1e-6);
        free(du);
        free(nodes);
        verify_free(body, &mesh);
    }
}

/* ---- a bar that hangs ---- */

/* u = rho g L^2 / 2 E at its end where nu is 0: quadratic. */
static void test_hanging(void)
{
    static const char *const names[3] = {"tet10", "hex20", "hex27"};
    static const char *const source = "u = rho g L^2 / 2 E";
    const double g = 2, tip = 1000 * g / (2 * young);
    for (int k = 0; k < 3; k++) {
        const verify_element *element = verify_element_named(names[k]);
        const verify_plane end = {0, 1};
        sb_mesh mesh = verify_box(element->type, 3, 1, 1, 1, 0.2, 0.2);
        sb_body_def def = verify_def(&mesh, element, sb_material_linear(REAL(young), 0, 1000));
        sb_parameter p[3] = {by(SB_PARAMETER_YOUNG), by(SB_PARAMETER_DENSITY), by(SB_PARAMETER_GRAVITY)};
        sb_real gradient[3];
        sb_vec3 *loss = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof *loss);
        sb_body *body;
        int tip_node = 0;
        def.gravity = sb_v3(REAL(g), 0, 0);
        body = scene_body(&def);
        verify_hold_symmetry(body, &mesh, 3);
        for (int i = 0; i < mesh.node_count; i++)
            if (verify_on_plane(&end, mesh.nodes[i]))
                tip_node = i;
        loss[tip_node].x = 1;
        solve(body);
        CHECK_OK(sb_body_gradient(body, loss, NULL, p, 3, gradient, NULL, NULL));
        verify("hanging bar, adjoint", names[k], source, "d(tip)/dE (m/Pa)", -tip / young, (double)gradient[0], 1e-8);
        verify("hanging bar, adjoint", names[k], source, "d(tip)/d(rho) (m^4/kg)", tip / 1000, (double)gradient[1],
               1e-8);
        verify("hanging bar, adjoint", names[k], source, "d(tip)/dg (s^2)", tip / g, (double)gradient[2], 1e-8);
        free(loss);
        verify_free(body, &mesh);
    }
}

/* ---- moduli from what is read ---- */

/* A cube of linear material under a traction t: u = t / E along it, -nu t / E across. Read at one corner, each to
 * sigma: var E = (E^2 sigma / t)^2; nu = -E v / t, of the mean of v and w: var nu = (E sigma / t)^2 (nu^2 + 1/2), and
 * their covariance (E sigma / t)^2 nu E. */
static void test_identified(void)
{
    static const char *const source = "u = t / E, v = w = -nu t / E";
    const double t = 100, sigma = 1e-3, nu = 0.3;
    static const char *const names[2] = {"tet4", "hex8"};
    for (int k = 0; k < 2; k++) {
        const verify_element *element = verify_element_named(names[k]);
        const verify_plane end = {0, 1};
        const sb_vec3 traction = sb_v3(REAL(t), 0, 0);
        const int start[2] = {0, 1};
        const sb_real weight = 1;
        sb_mesh mesh = distorted_cube(element);
        sb_body *body = verify_body(&mesh, element, sb_material_linear(1000, REAL(0.2), 1000));
        sb_identify_def def = sb_default_identify_def();
        sb_parameter p[2] = {by(SB_PARAMETER_YOUNG), by(SB_PARAMETER_POISSON)};
        sb_measurement seen;
        sb_mapping row;
        sb_vec3 point = sb_v3(REAL(1 + t / young), REAL(1 - nu * t / young), REAL(1 - nu * t / young));
        sb_real values[2] = {1000, REAL(0.2)}, deviations[2], correlations[4];
        double along = young * sigma / t, both;
        int corner = 0;
        for (int i = 0; i < mesh.node_count; i++)
            if (sb_v3_dot(mesh.nodes[i], sb_v3(1, 1, 1)) > sb_v3_dot(mesh.nodes[corner], sb_v3(1, 1, 1)))
                corner = i;
        verify_hold_symmetry(body, &mesh, 3);
        verify_load(body, &mesh, verify_on_plane, &end, verify_uniform, &traction);
        row.row_count = 1, row.row_start = start, row.nodes = &corner, row.weights = &weight;
        memset(&seen, 0, sizeof seen);
        seen.rows = &row, seen.points = &point, seen.sigma_point = REAL(sigma);
        def.body = body, def.parameters = p, def.count = 2, def.measurements = &seen;
        def.correlations = correlations;
        CHECK_OK(sb_identify(&def, values, deviations, NULL, NULL, NULL));
        verify("moduli from a corner's place", names[k], source, "E (Pa)", young, (double)values[0], 1e-8);
        verify("moduli from a corner's place", names[k], source, "nu", nu, (double)values[1], 1e-8);
        verify("moduli from a corner's place", names[k], source, "deviation of E (Pa)", young * along,
               (double)deviations[0], 1e-7);
        both = sqrt(nu * nu + 0.5);
        verify("moduli from a corner's place", names[k], source, "deviation of nu", along * both, (double)deviations[1],
               1e-7);
        verify("moduli from a corner's place", names[k], source, "their correlation", nu / both,
               (double)correlations[1], 1e-7);
        verify_free(body, &mesh);
    }
}

static void test_table(void) { verify_table("verification_sensitivities"); }

CHECK_SUITE(verification_sensitivities, {"stretched", test_stretched}, {"hanging", test_hanging},
            {"identified", test_identified}, {"table", test_table});
