/* Natural frequencies against closed forms: discrete chains exactly; bars, beams, rods in torsion and blocks
 * between frictionless walls within the error of mesh and theory; a column under tension. */
#include "verification_scene.h"

static const double young = 1e4, density = 1000;

typedef struct resolution {
    const char *element;
    int nx, ny, nz;
    double bound;
} resolution;

static void name_with_mesh(char *name, size_t size, const char *text, const resolution *r)
{
    snprintf(name, size, "%s, %dx%dx%d", text, r->nx, r->ny, r->nz);
}

/* Frequencies (rad/s) of the lowest modes; shapes may be NULL. */
static void modes_of(sb_body *body, int count, sb_mass_kind mass, int at_present, double *w, sb_vec3 *shapes)
{
    sb_modes_options options = sb_default_modes_options();
    sb_real f[16];
    sb_error error;
    memset(f, 0, sizeof f);
    options.mass = mass;
    options.at_present = at_present;
    options.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-3 : 1e-8);
    if (!CHECK_OK(sb_body_modes(body, count, &options, f, shapes, NULL, &error)))
        printf("%s\n", error.message);
    for (int k = 0; k < count; k++)
        w[k] = 2 * VERIFY_PI * (double)f[k];
}

/* ---- chains ---- */

/* A column of n hex8 guided along x or y, held at x = 0: w^2 = 4 M/(rho h^2) s^2 with s = sin(k h/2), k = (j
 * - 1/2) pi/L, over 1 - 2/3 s^2 with the consistent mass. */
static void test_chain(void)
{
    static const int cells = 12;
    static const double poisson = 0.3, h = 1.0 / 12;
    verify_constants c = verify_constants_of(young, poisson);
    for (int axis = 0; axis < 2; axis++)
        for (int consistent = 0; consistent < 2; consistent++) {
            sb_mesh mesh = verify_box(SB_HEX8, cells, 1, 1, 1, h, h);
            sb_body *body = verify_body(&mesh, verify_element_named("hex8"),
                                        sb_material_linear(REAL(young), REAL(poisson), REAL(density)));
            double w[4];
            for (int i = 0; i < mesh.node_count; i++)
                CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_XYZ & ~(1 << axis)));
            scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
            modes_of(body, 3, consistent ? SB_MASS_CONSISTENT : SB_MASS_LUMPED, 0, w, NULL);
            for (int j = 0; j < 3; j++) {
                double s = sin((j + 0.5) * VERIFY_PI * h / 2), modulus = axis == 0 ? c.lambda + 2 * c.mu : c.mu;
                char name[80];
                snprintf(name, sizeof name, "%s mode %d of a column, 12 cells", axis ? "shear" : "dilatational", j + 1);
                verify(name, consistent ? "hex8, consistent mass" : "hex8, lumped mass", "exact discrete mode",
                       "angular frequency (1/s)",
                       2 / h * s * sqrt(modulus / density / (consistent ? 1 - 2.0 / 3 * s * s : 1)), w[j], 1e-8);
            }
            verify_free(body, &mesh);
        }
}

/* A column held at both ends, stretched to 1.2 and guided: its modulus is dP/dl there, its length the one at
 * rest. */
static void test_stretched_column(void)
{
    static const int cells = 12;
    static const double poisson = 0.3, h = 1.0 / 12, stretch = 1.2, step = 1e-4;
    static const verify_plane end = {0, 1};
    verify_constants c = verify_constants_of(young, poisson);
    for (int m = 0; m < VERIFY_MATERIALS; m++) {
        double l[3] = {1, 1, 1}, at[4], stress[3], modulus, w[1], s = sin(VERIFY_PI * h / 2);
        sb_mesh mesh = verify_box(SB_HEX8, cells, 1, 1, 1, h, h);
        sb_body *body = verify_body(&mesh, verify_element_named("hex8"),
                                    verify_materials[m].make(REAL(young), REAL(poisson), REAL(density)));
        for (int k = 0; k < 4; k++) { /* differences of fourth order */
            l[0] = stretch + (k < 2 ? k - 2 : k - 1) * step;
            verify_materials[m].principal(c, l, stress);
            at[k] = stress[0];
        }
        modulus = (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * step);
        for (int i = 0; i < mesh.node_count; i++)
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_Y | SB_Z));
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        verify_move(body, &mesh, verify_on_plane, &end, SB_X, sb_v3(REAL(stretch - 1), 0, 0));
        verify_solve(body);
        modes_of(body, 1, SB_MASS_LUMPED, 1, w, NULL);
        verify("column stretched to 1.2, held at both ends, 12 cells", verify_materials[m].name,
               "exact discrete mode with dP/dl (Ogden 1997)", "angular frequency (1/s)",
               2 / h * s * sqrt(modulus / density), w[0], 1e-8);
        verify_free(body, &mesh);
    }
}

/* ---- bars and beams ---- */

static void test_bar(void)
{
    static const resolution meshes[] = {{"tet4", 40, 1, 1, 0.0011}, {"tet10", 8, 1, 1, 1.3e-4},
                                        {"hex8", 40, 1, 1, 0.0012}, {"hex8, B-bar", 40, 1, 1, 0.0012},
                                        {"hex20", 8, 1, 1, 1.6e-4}, {"hex27", 8, 1, 1, 1.6e-4}};
    for (size_t i = 0; i < sizeof meshes / sizeof meshes[0]; i++) {
        const resolution *r = meshes + i;
        const verify_element *element = verify_element_named(r->element);
        sb_mesh mesh = verify_box(element->type, r->nx, r->ny, r->nz, 1, 0.05, 0.05);
        sb_body *body = verify_body(&mesh, element, sb_material_linear(REAL(young), 0, REAL(density)));
        char name[80];
        double w[2];
        for (int k = 0; k < mesh.node_count; k++)
            CHECK_OK(sb_body_fix_nodes(body, &k, 1, SB_Y | SB_Z));
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        modes_of(body, 2, SB_MASS_CONSISTENT, 0, w, NULL);
        for (int k = 0; k < 2; k++) {
            snprintf(name, sizeof name, "axial mode %d of a guided bar, %dx%dx%d", k + 1, r->nx, r->ny, r->nz);
            verify(name, r->element, "(k - 1/2) pi (E/rho L^2)^(1/2)", "angular frequency (1/s)",
                   (k + 0.5) * VERIFY_PI * sqrt(young / density), w[k], r->bound);
        }
        verify_free(body, &mesh);
    }
}

static void test_cantilever(void)
{
    static const resolution meshes[] = {{"tet4", 40, 2, 2, -0.266}, {"tet10", 10, 1, 1, 0.0015},
                                        {"hex8", 40, 2, 2, -0.059}, {"hex8, B-bar", 40, 2, 2, -0.059},
                                        {"hex20", 10, 1, 1, 0.002}, {"hex27", 10, 1, 1, 0.002}};
    static const double h = 0.05, beta = 1.8751040687119611;
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("rounding in K x is some epsilon (L/h)^4 of the lowest eigenvalue");
        return;
    }
    for (size_t i = 0; i < sizeof meshes / sizeof meshes[0]; i++) {
        const resolution *r = meshes + i;
        const verify_element *element = verify_element_named(r->element);
        sb_mesh mesh = verify_box(element->type, r->nx, r->ny, r->nz, 1, h, h);
        sb_body *body = verify_body(&mesh, element, sb_material_linear(REAL(young), 0, REAL(density)));
        char name[80];
        double w[2];
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        modes_of(body, 2, SB_MASS_CONSISTENT, 0, w, NULL);
        name_with_mesh(name, sizeof name, "bending of a cantilever L/h = 20", r);
        verify(name, r->element, "Euler-Bernoulli: 1.8751^2 (EI/rho A L^4)^(1/2)", "angular frequency (1/s)",
               beta * beta * h * sqrt(young / (12 * density)), w[0], r->bound);
        verify_free(body, &mesh);
    }
}

/* Six rigid motions, then pairs. */
static void test_free_beam(void)
{
    static const double h = 0.05, beta[2] = {4.7300407448627040, 7.8532046240958376};
    static const resolution meshes[] = {{"tet4", 40, 2, 2, -0.25},   {"tet10", 10, 1, 1, 0.025},
                                        {"hex8", 40, 2, 2, -0.0476}, {"hex8, B-bar", 40, 2, 2, -0.0476},
                                        {"hex20", 10, 1, 1, 0.03},   {"hex27", 10, 1, 1, 0.03}};
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("rounding in K x is some epsilon (L/h)^4 of the lowest eigenvalue");
        return;
    }
    for (size_t i = 0; i < sizeof meshes / sizeof meshes[0]; i++) {
        const resolution *r = meshes + i;
        const verify_element *element = verify_element_named(r->element);
        sb_mesh mesh = verify_box(element->type, r->nx, r->ny, r->nz, 1, h, h);
        sb_body *body = verify_body(&mesh, element, sb_material_linear(REAL(young), 0, REAL(density)));
        char name[80];
        double w[10], rigid = 0;
        modes_of(body, 10, SB_MASS_CONSISTENT, 0, w, NULL);
        for (int k = 0; k < 6; k++)
            rigid = verify_worse(rigid, w[k] / w[6]);
        name_with_mesh(name, sizeof name, "free beam L/h = 20", r);
        verify(name, r->element, "six rigid motions", "largest of their frequencies/first elastic", 0, rigid, 1e-5);
        for (int k = 0; k < 2; k++)
            verify(name, r->element,
                   k ? "Euler-Bernoulli: 7.8532^2 (EI/rho A L^4)^(1/2)"
                     : "Euler-Bernoulli: 4.7300^2 (EI/rho A L^4)^(1/2)",
                   "angular frequency (1/s)", beta[k] * beta[k] * h * sqrt(young / (12 * density)), w[6 + 2 * k],
                   r->bound);
        verify_free(body, &mesh);
    }
}

/* ---- torsion ---- */

/* The mode that turns the sections about x most. */
static int turning_mode(const sb_mesh *mesh, const sb_vec3 *shapes, int count)
{
    int best = 0;
    double most = 0;
    for (int k = 0; k < count; k++) {
        double turn = 0, size = 0;
        for (int i = 0; i < mesh->node_count; i++) {
            sb_vec3 x = mesh->nodes[i], u = shapes[(size_t)k * (size_t)mesh->node_count + (size_t)i];
            turn += (double)(x.y * u.z - x.z * u.y);
            size += (double)sb_v3_dot(u, u);
        }
        if (fabs(turn) / sqrt(size) > most) {
            most = fabs(turn) / sqrt(size);
            best = k;
        }
    }
    return best;
}

static void test_torsion(void)
{
    static const resolution meshes[] = {{"tet10", 3, 4, 4, 0.027},
                                        {"hex8", 12, 8, 8, 0.0015},
                                        {"hex8, B-bar", 12, 8, 8, 0.0015},
                                        {"hex20", 3, 4, 4, 3e-4},
                                        {"hex27", 3, 4, 4, 1e-4}};
    enum { MODES = 5 };
    static const double radius = 0.2, poisson = 0.3;
    for (size_t i = 0; i < sizeof meshes / sizeof meshes[0]; i++) {
        const resolution *r = meshes + i;
        const verify_element *element = verify_element_named(r->element);
        double w[MODES];
        char name[80];
        sb_mesh mesh;
        sb_body *body;
        sb_vec3 *shapes;
        if (!CHECK_OK(sb_mesh_cylinder(element->type, 0, REAL(radius), 1, r->ny, r->nx, NULL, &mesh, NULL)))
            continue;
        verify_round(&mesh, radius);
        body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(poisson), REAL(density)));
        shapes = (sb_vec3 *)malloc((size_t)(MODES * mesh.node_count) * sizeof(sb_vec3));
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        modes_of(body, MODES, SB_MASS_CONSISTENT, 0, w, shapes);
        snprintf(name, sizeof name, "torsion of a clamped round bar L/R = 5, %d cells across, %d along", r->ny, r->nx);
        verify(name, r->element, "pi/2 (G/rho L^2)^(1/2)", "angular frequency (1/s)",
               VERIFY_PI / 2 * sqrt(young / (2 * (1 + poisson)) / density), w[turning_mode(&mesh, shapes, MODES)],
               r->bound);
        free(shapes);
        verify_free(body, &mesh);
    }
}

/* ---- a block between frictionless walls ---- */

/* u_x = a sin(l pi x) cos(m pi y) cos(n pi z) and so on is a mode of the unit cube whose faces slide on
 * walls: shear waves w^2 = mu/rho pi^2 (l^2 + m^2 + n^2) where (a, b, c) is across (l, m, n), pressure waves
 * with lambda + 2 mu along it. With nu = 0.3 the lowest are (1,1,0) in shear, three times; (1,1,1) in shear,
 * twice; (1,0,0) in pressure, three times. */
static void test_walls(void)
{
    static const resolution meshes[] = {{"tet4", 6, 6, 6, 0.12},   {"tet10", 3, 3, 3, 0.03},
                                        {"hex8", 6, 6, 6, 0.053},  {"hex8, B-bar", 6, 6, 6, 0.035},
                                        {"hex20", 3, 3, 3, 0.004}, {"hex27", 3, 3, 3, 0.0035}};
    static const double poisson = 0.3;
    static const struct {
        const char *name;
        int first, last;
    } waves[] = {
        {"shear (1,1,0), 3 modes", 0, 2}, {"shear (1,1,1), 2 modes", 3, 4}, {"pressure (1,0,0), 3 modes", 5, 7}};
    verify_constants c = verify_constants_of(young, poisson);
    const double squares[3] = {2 * c.mu, 3 * c.mu, c.lambda + 2 * c.mu};
    for (size_t i = 0; i < sizeof meshes / sizeof meshes[0]; i++) {
        const resolution *r = meshes + i;
        const verify_element *element = verify_element_named(r->element);
        sb_mesh mesh = verify_box(element->type, r->nx, r->ny, r->nz, 1, 1, 1);
        sb_body *body = verify_body(&mesh, element, sb_material_linear(REAL(young), REAL(poisson), REAL(density)));
        char name[80];
        double w[8];
        for (int axis = 0; axis < 3; axis++) {
            scene_fix_plane(body, &mesh, axis, 0, 1 << axis);
            scene_fix_plane(body, &mesh, axis, 1, 1 << axis);
        }
        modes_of(body, 8, SB_MASS_CONSISTENT, 0, w, NULL);
        name_with_mesh(name, sizeof name, "block between frictionless walls", r);
        for (int k = 0; k < 3; k++) {
            double expected = VERIFY_PI * sqrt(squares[k] / density), worst = w[waves[k].first];
            for (int j = waves[k].first; j <= waves[k].last; j++)
                if (fabs(w[j] - expected) > fabs(worst - expected))
                    worst = w[j];
            verify(name, r->element, waves[k].name, "angular frequency (1/s), the farthest off", expected, worst,
                   r->bound);
        }
        verify_free(body, &mesh);
    }
}

static void test_table(void) { verify_table("verification_modes"); }

CHECK_SUITE(verification_modes, {"chain", test_chain}, {"stretched column", test_stretched_column}, {"bar", test_bar},
            {"cantilever", test_cantilever}, {"free beam", test_free_beam}, {"torsion", test_torsion},
            {"block between walls", test_walls}, {"table", test_table});
