/* Heat: closed forms of conduction and of Pennes' equation on even and distorted meshes, Arrhenius' law. */
#include <stdlib.h>

#include "heat_scene.h"
#include "verification_scene.h"

/* ---- a held sphere in perfused tissue ---- */

typedef struct bumped {
    verify_shell shell;
    double amount; /* of distortion inside */
} bumped;

/* A sixth of a sphere's shell with radii and angles at even distances, distorted inside. */
static sb_vec3 map_bumped(const void *user, double x, double y, double z)
{
    const bumped *b = (const bumped *)user;
    sb_vec3 at = verify_map_distorted(&b->amount, x, y, z);
    return verify_map_even_shell(&b->shell, (double)at.x, (double)at.y, (double)at.z);
}

static const double outer = 0.02; /* m */

/* Steady temperatures with n cells across; error over the nodes, and temperature above the blood's at 10 mm (K). */
static double sphere(const char *name, int n, double amount, double *at_10)
{
    const verify_element *element = verify_element_named(name);
    heat_sphere s = heat_needle_sphere();
    sb_heat_def def = sb_default_heat_def();
    bumped b;
    double error = 1e30;
    b.shell.inner = s.radius;
    b.shell.outer = outer;
    b.shell.axis = 0;
    b.amount = amount;
    sb_mesh mesh = verify_block(element->type, n, n / 2, n / 2, map_bumped, &b, 0);
    sb_body *body = heat_body(&mesh, element->integration, NULL);
    sb_heat *heat;
    def.tolerance = REAL(scene_tolerance(1e-10, 1000));
    heat = heat_of(body, &def);
    heat_hold_sphere(heat, &mesh, &s, outer);
    if (CHECK_OK(sb_heat_solve_steady(heat, NULL, NULL)))
        error = heat_error(heat, &mesh, heat_sphere_form, &s);
    for (int i = 0; i < mesh.node_count && at_10; i++)
        if ((double)sb_v3_norm(sb_v3_sub(mesh.nodes[i], sb_v3(REAL(0.01), 0, 0))) < 1e-6)
            *at_10 = (double)sb_heat_temperatures(heat)[i] - s.blood;
    sb_heat_destroy(heat);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return error;
}

static void test_sphere(void)
{
    static const char *const names[5] = {"tet4", "tet10", "hex8", "hex20", "hex27"};
    static const double bounds[2][5] = {{3e-2, 2e-2, 2e-2, 1e-2, 2e-3}, {3e-2, 2e-2, 3e-2, 1e-2, 2e-3}};
    for (int distorted = 0; distorted < 2; distorted++)
        for (int t = 0; t < 5; t++) {
            double rise = 0;
            char name[100];
            sphere(names[t], 12, 0.04 * distorted, &rise);
            snprintf(name, sizeof name, "sphere of 5 mm held 43 K above its blood, 12 %s cells to 20 mm",
                     distorted ? "distorted" : "even");
            verify(name, names[t], "(a/r) exp((a - r)/d), d^2 = k/w", "rise at 10 mm (K)", 7.1827, rise,
                   bounds[distorted][t]);
        }
}

static void test_order(void)
{
    static const char *const names[3] = {"tet4", "tet10", "hex8"};
    for (int distorted = 0; distorted < 2; distorted++)
        for (int t = 0; t < 3; t++) {
            double coarse = sphere(names[t], 6, 0.04 * distorted, NULL);
            double fine = sphere(names[t], 12, 0.04 * distorted, NULL);
            verify(distorted ? "the same, distorted" : "the same, even", names[t], "second order in the cells' size",
                   "log2 of the errors' ratio, 6 and 12 cells", 2, log(coarse / fine) / log(2.0), 0.2);
        }
}

/* ---- slabs ---- */

static void step_for(sb_heat *heat, int steps, double time)
{
    for (int k = 0; k < steps; k++)
        CHECK_OK(sb_heat_step(heat, REAL(time / steps), NULL, NULL));
}

static const char *const slab_names[4] = {"tet4", "tet10", "hex8", "hex20"};

static sb_mesh slab_mesh(const char *name, double length, int cells)
{
    double h = length / cells;
    return scene_box(verify_element_named(name)->type, cells, 2, 2, sb_v3(REAL(length), REAL(2 * h), REAL(2 * h)), 0.2);
}

/* No blood, k/c = 1.25e-7 m^2/s. */
static sb_heat_def dry(void)
{
    sb_heat_def def = sb_default_heat_def();
    def.tissue.perfusion = 0;
    def.tissue.capacity = 4000000;
    def.tolerance = REAL(scene_tolerance(1e-10, 1000));
    return def;
}

static void test_jump(void)
{
    for (int t = 0; t < 4; t++) {
        sb_mesh mesh = slab_mesh(slab_names[t], 0.02, 16);
        sb_heat_def def = dry();
        sb_body *body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
        sb_heat *heat = heat_of(body, &def);
        heat_slab slab = {0.02, 1.25e-7, 300, 310.15, 330.15};
        double mean = 0, expected = 0;
        int count = 0;
        heat_hold_plane(heat, &mesh, 0, 0, 330.15);
        heat_hold_plane(heat, &mesh, 0, 0.02, 330.15);
        step_for(heat, 300, 300);
        for (int i = 0; i < mesh.node_count; i++)
            if (fabs((double)mesh.nodes[i].x - 0.01) < 1e-7) {
                mean += (double)sb_heat_temperatures(heat)[i] - 310.15;
                expected = heat_slab_form(&slab, mesh.nodes[i]) - 310.15;
                count++;
            }
        verify("slab of 20 mm whose sides jump by 20 K, steps of 1 s", slab_names[t],
               "4/pi sum sin(k pi x/l)/k exp(-(k pi/l)^2 a t)", "rise in the middle after 300 s (K)", expected,
               mean / count, 5e-3);
        verify("the same", slab_names[t], "the same", "rms error over all nodes/20 K", 0,
               heat_error(heat, &mesh, heat_slab_form, &slab) / 20, 2e-3);
        sb_heat_destroy(heat);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

static void test_flux(void)
{
    for (int t = 0; t < 4; t++) {
        sb_mesh mesh = slab_mesh(slab_names[t], 0.04, 32);
        sb_heat_def def = dry();
        sb_body *body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
        sb_heat *heat = heat_of(body, &def);
        double expected = 2 * 1000 / 0.5 * sqrt(1.25e-7 * 200 / HEAT_PI), mean = 0;
        int face_count, corners, *faces = heat_faces(&mesh, 0, 0, &face_count, &corners), count = 0;
        CHECK_OK(sb_heat_add_flux(heat, faces, face_count, corners, 1000, NULL, NULL));
        step_for(heat, 200, 200);
        for (int i = 0; i < mesh.node_count; i++)
            if ((double)mesh.nodes[i].x < 1e-7)
                mean += (double)sb_heat_temperatures(heat)[i] - 310.15, count++;
        verify("1000 W/m^2 into half a space, steps of 1 s", slab_names[t], "2 q/k sqrt(a t/pi)",
               "rise of the surface after 200 s (K)", expected, mean / count, 1e-2);
        free(faces);
        sb_heat_destroy(heat);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* Perfused, one end held, the other in air: T - T_a = A cosh m x + B sinh m x, k T' = -h (T - T_air) there. */
static double fin_form(const void *user, sb_vec3 x)
{
    const double *f = (const double *)user; /* A, B, m */
    return 310.15 + f[0] * cosh(f[2] * (double)x.x) + f[1] * sinh(f[2] * (double)x.x);
}

static void test_fin(void)
{
    const double k = 0.5, h = 200, length = 0.015, m = sqrt(24041 / k), held = 30, air = -15;
    const double B = (h * air - held * (k * m * sinh(m * length) + h * cosh(m * length))) /
                     (k * m * cosh(m * length) + h * sinh(m * length));
    const double form[3] = {held, B, m};
    for (int t = 0; t < 4; t++) {
        sb_mesh mesh = slab_mesh(slab_names[t], length, 15);
        sb_heat_def def = sb_default_heat_def();
        sb_body *body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
        sb_heat *heat;
        int face_count, corners, *faces = heat_faces(&mesh, 0, length, &face_count, &corners);
        def.tolerance = REAL(scene_tolerance(1e-10, 1000));
        heat = heat_of(body, &def);
        heat_hold_plane(heat, &mesh, 0, 0, 310.15 + held);
        CHECK_OK(sb_heat_add_convection(heat, faces, face_count, corners, REAL(h), REAL(310.15 + air), NULL, NULL));
        CHECK_OK(sb_heat_solve_steady(heat, NULL, NULL));
        verify("perfused slab, one end held, the other in moving air", slab_names[t], "A cosh m x + B sinh m x",
               "rms error over all nodes/30 K", 0, heat_error(heat, &mesh, fin_form, form) / 30, 2e-3);
        free(faces);
        sb_heat_destroy(heat);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* ---- metabolic heat and an applicator ---- */

static double parabola(const void *user, sb_vec3 x)
{
    (void)user;
    return 310.15 + 50000 * (double)x.x * (0.02 - (double)x.x) / (2 * 0.5);
}

static void test_metabolic(void)
{
    for (int t = 0; t < 4; t++) {
        sb_mesh mesh = slab_mesh(slab_names[t], 0.02, 12);
        sb_heat_def def = dry();
        sb_body *body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
        sb_heat *heat;
        def.tissue.metabolic = 50000;
        heat = heat_of(body, &def);
        heat_hold_plane(heat, &mesh, 0, 0, 310.15);
        heat_hold_plane(heat, &mesh, 0, 0.02, 310.15);
        CHECK_OK(sb_heat_solve_steady(heat, NULL, NULL));
        verify("slab that makes 50 kW/m^3, without blood", slab_names[t], "Q x (l - x)/(2 k)",
               "rms error over all nodes/5 K", 0, heat_error(heat, &mesh, parabola, NULL) / 5, 5e-3);
        sb_heat_destroy(heat);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* A Gaussian ball of power: from three of its radii on it is a point's, times exp(s^2/(2 d^2)). */
static void test_applicator(void)
{
    static const char *const names[3] = {"tet4", "hex8", "tet10"};
    const double power = 0.4, sigma = 0.0015, d = sqrt(0.5 / 24041), size = 0.015;
    const double scale = power / (4 * HEAT_PI * 0.5) * exp(sigma * sigma / (2 * d * d));
    for (int t = 0; t < 3; t++) {
        int cells = t == 2 ? 10 : 20;
        sb_mesh mesh = scene_box(verify_element_named(names[t])->type, cells, cells, cells,
                                 sb_v3(REAL(size), REAL(size), REAL(size)), 0.2);
        sb_heat_def def = sb_default_heat_def();
        sb_body *body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
        sb_heat *heat = heat_of(body, &def);
        double worst = 0;
        for (int i = 0; i < mesh.node_count; i++) { /* an octant of space: three sides are symmetric */
            double x = (double)mesh.nodes[i].x, y = (double)mesh.nodes[i].y, z = (double)mesh.nodes[i].z;
            double r = sqrt(x * x + y * y + z * z);
            sb_real kelvin = REAL(310.15 + scale / (r > 0 ? r : 1) * exp(-r / d));
            if (fmax(x, fmax(y, z)) > size - 1e-7)
                CHECK_OK(sb_heat_hold(heat, &i, 1, &kelvin, 1, NULL));
        }
        CHECK_OK(sb_heat_add_source(heat, sb_v3(0, 0, 0), sb_v3(0, 0, 0), REAL(sigma), REAL(power / 8), NULL, NULL));
        CHECK_OK(sb_heat_solve_steady(heat, NULL, NULL));
        for (int i = 0; i < mesh.node_count; i++) {
            double r = (double)sb_v3_norm(mesh.nodes[i]);
            if (r > 4 * sigma && r < 7 * sigma)
                worst = fmax(worst, fabs((double)sb_heat_temperatures(heat)[i] - 310.15 - scale / r * exp(-r / d)) /
                                        (scale / (4 * sigma) * exp(-4 * sigma / d)));
        }
        verify("0.4 W in a ball of 1.5 mm in perfused tissue", names[t], "P/(4 pi k r) exp(-r/d + s^2/(2 d^2))",
               "largest error from 6 to 10.5 mm/rise at 6 mm", 0, worst, 4e-2);
        sb_heat_destroy(heat);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* ---- all nodes alike ---- */

static void test_uniform(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 3, 3, 3, sb_v3(REAL(0.01), REAL(0.01), REAL(0.01)), 0.2);
    sb_heat_def def = sb_default_heat_def();
    sb_body *body = heat_body(&mesh, SB_INTEGRATION_AUTO, NULL);
    sb_heat *heat;
    double expected;
    def.start = REAL(320.15);
    def.tissue.capacity = 4000000;
    def.activation = REAL(1e6); /* nothing dies */
    heat = heat_of(body, &def);
    step_for(heat, 500, 50);
    expected = 10 * exp(-24041.0 / 4e6 * 50);
    verify("warm body without neighbours, steps of 0.1 s", "tet4", "exp(-w t/c)", "above its blood after 50 s (K)",
           expected, (double)sb_heat_temperatures(heat)[13] - 310.15, 1e-3);
    sb_heat_destroy(heat);
    def = sb_default_heat_def();
    def.start = def.blood = REAL(333.15);
    heat = heat_of(body, &def);
    step_for(heat, 3449, 3.449);
    verify("tissue at 60 C", "liver", "A exp(-E/(R T)) t", "damage after 3.449 s", 1, (double)sb_heat_damage(heat)[13],
           2e-3);
    verify("the same", "liver", "1 - exp(-Om)", "dead volume/volume", 1 - exp(-1.0),
           (double)sb_heat_dead_volume(heat) / 1e-6, 2e-3);
    sb_heat_destroy(heat);
    def = dry();
    def.start = REAL(371.15);
    def.tissue.latent_heat = REAL(1e9);
    heat = heat_of(body, &def);
    CHECK_OK(sb_heat_add_element_source(heat, NULL, 0, REAL(1e7), NULL, NULL));
    step_for(heat, 208, 104); /* 4 K of 4 MJ/m^3 and the latent heat: 101.6 s; the rest warms by 6 K */
    verify("boiling: 1e7 W/m^3 through 1e9 J/m^3", "tet4", "q t = c (T - T_0) + L", "T - T_0 after 104 s (K)", 10,
           (double)sb_heat_temperatures(heat)[13] - 371.15,
           SB_REAL_IS_FLOAT ? 2e-2 : 1e-6); /* in float a step's 0.01 K are 300 roundings */
    sb_heat_destroy(heat);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_table(void) { verify_table("verification_heat"); }

CHECK_SUITE(verification_heat, {"sphere", test_sphere}, {"order", test_order}, {"jump", test_jump}, {"flux", test_flux},
            {"fin", test_fin}, {"metabolic", test_metabolic}, {"applicator", test_applicator},
            {"uniform", test_uniform}, {"table", test_table});
