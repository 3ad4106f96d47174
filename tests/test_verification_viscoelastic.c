/* Prony terms in bodies: relaxation, ramps, creep, storage and loss moduli, and the two limits that static
 * solves find.
 *
 * mu relaxes as g(t) = 1 - sum g_i (1 - exp(-t/tau_i)), the bulk modulus K does not. Every energy is linear
 * in its moduli, so a strain that is applied at once and held has the stress of the elastic material with mu
 * g(t) and K. */
#include "verification_scene.h"

static const double young = 5e3, poisson = 0.4, exact = 1e-8;

enum { TERMS = 2 };
static const double g[TERMS] = {0.4, 0.25}, tau[TERMS] = {0.05, 0.8};

static sb_material relaxing(const verify_material *material)
{
    sb_real shares[TERMS], times[TERMS];
    for (int i = 0; i < TERMS; i++) {
        shares[i] = REAL(g[i]);
        times[i] = REAL(tau[i]);
    }
    /* as good as without inertia */
    return sb_material_with_prony(material->make(REAL(young), REAL(poisson), REAL(1e-9)), shares, times, TERMS);
}

static double relaxation(double t)
{
    double left = 1;
    for (int i = 0; i < TERMS; i++)
        left -= g[i] * (1 - exp(-t / tau[i]));
    return left;
}

static int relaxes(const verify_material *material)
{
    return sb_material_is_hyperelastic(material->make(1, 0, 1).model);
}

/* The elastic constants when a share of mu is left, and all of K; c10, c01, c20 and c30 are multiples of mu.
 */
static verify_constants constants_at(double share)
{
    verify_constants c = verify_constants_of(young, poisson);
    c.mu *= share;
    c.lambda = c.bulk - 2 * c.mu / 3;
    return c;
}

static sb_mesh distorted_cube(sb_element_type type)
{
    static const double amplitude = 0.05;
    return verify_block(type, 2, 2, 2, verify_map_distorted, &amplitude, 1);
}

static sb_body *make_body(const sb_mesh *mesh, const verify_element *element, sb_material material)
{
    sb_body_def def = verify_def(mesh, element, material);
    def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-6 : 1e-13);
    def.newton_tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-12);
    def.max_iterations = 5000;
    return scene_body(&def);
}

/* Static equilibrium to rounding, right after the change or long after. */
static void solve(sb_body *body, int instantaneous)
{
    sb_static_options options = sb_default_static_options();
    options.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-4 : 1e-12);
    options.instantaneous = instantaneous;
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
}

/* The surface follows x = G X; the inside is free. */
static void move_surface(sb_body *body, const sb_mesh *mesh, const double G[3][3])
{
    scene_fix_boundary(body, mesh);
    for (int i = 0; i < mesh->node_count; i++) {
        const double x[3] = {(double)mesh->nodes[i].x, (double)mesh->nodes[i].y, (double)mesh->nodes[i].z};
        double u[3];
        sb_vec3 to;
        for (int k = 0; k < 3; k++)
            u[k] = G[k][0] * x[0] + G[k][1] * x[1] + G[k][2] * x[2] - x[k];
        to = sb_v3(REAL(u[0]), REAL(u[1]), REAL(u[2]));
        if (sb_body_supports(body)[i])
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &to, 1));
    }
}

/* Mean of P_ij: the sum of f_i X_j over the forces at the surface of the unit cube. */
static double mean_stress(const sb_body *body, const sb_mesh *mesh, int i, int j)
{
    double sum = 0;
    for (int n = 0; n < mesh->node_count; n++)
        sum += (double)scene_component(sb_body_reactions(body)[n], i) * (double)scene_component(mesh->nodes[n], j);
    return sum;
}

/* ---- relaxation ---- */

static const double stretch[3] = {1.3, 0.9, 0.95};

/* Stress P_11 at times[0 .. count) after the stretches came at once. */
static void relax(const verify_element *element, const verify_material *material, const double *times, int count,
                  double *stress)
{
    const double G[3][3] = {{stretch[0], 0, 0}, {0, stretch[1], 0}, {0, 0, stretch[2]}};
    sb_mesh mesh = distorted_cube(element->type);
    sb_body *body = make_body(&mesh, element, relaxing(material));
    double last = 0;
    move_surface(body, &mesh, G);
    solve(body, 1);
    for (int k = 0; k < count; k++) {
        if (times[k] > last)
            CHECK_OK(sb_body_step(body, REAL(times[k] - last), NULL));
        last = times[k];
        stress[k] = mean_stress(body, &mesh, 0, 0);
    }
    verify_free(body, &mesh);
}

static void test_relaxation(void)
{
    enum { TIMES = 4 };
    static const double times[TIMES] = {0, 0.03, 0.5, 3};
    for (int m = 0; m < VERIFY_MATERIALS; m++) {
        const verify_material *material = verify_materials + m;
        double expected[TIMES], worst[TIMES], unused[3];
        if (!relaxes(material))
            continue;
        for (int k = 0; k < TIMES; k++) {
            material->principal(constants_at(relaxation(times[k])), stretch, unused);
            expected[k] = worst[k] = unused[0];
        }
        for (int e = 0; e < VERIFY_ELEMENTS; e++) {
            double found[TIMES];
            if (!verify_suits(verify_elements + e, SB_NEO_HOOKEAN))
                continue;
            relax(verify_elements + e, material, times, TIMES, found);
            for (int k = 0; k < TIMES; k++)
                if (!(fabs(found[k] - expected[k]) <= fabs(worst[k] - expected[k])))
                    worst[k] = found[k];
        }
        for (int k = 0; k < TIMES; k++) {
            char name[80];
            snprintf(name, sizeof name, "stretches 1.3, 0.9, 0.95 at once, after %g s", times[k]);
            verify(name, material->name, "P with K and mu g(t), g(t) = 1 - sum g_i (1 - exp(-t/tau_i))", "P_11 (Pa)",
                   expected[k], worst[k], exact);
        }
    }
}

/* A small shear that grows evenly: P_12 = mu rate (g_inf t + sum g_i tau_i (1 - exp(-t/tau_i))), exactly
 * whatever the steps. */
static void test_ramp(void)
{
    static const double steps[4] = {0.01, 0.2, 0.04, 0.5}, rate = 1e-5;
    double mu = verify_constants_of(young, poisson).mu, rest = 1 - g[0] - g[1];
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("small strains need double");
        return;
    }
    for (int e = 0; e < VERIFY_ELEMENTS; e++) {
        const verify_element *element = verify_elements + e;
        double t = 0, expected, found = 0;
        sb_mesh mesh;
        sb_body *body;
        if (!verify_suits(element, SB_NEO_HOOKEAN))
            continue;
        mesh = distorted_cube(element->type);
        body = make_body(&mesh, element, relaxing(verify_materials + 5));
        for (int s = 0; s < 4; s++) {
            t += steps[s];
            const double G[3][3] = {{1, rate * t, 0}, {0, 1, 0}, {0, 0, 1}};
            move_surface(body, &mesh, G);
            CHECK_OK(sb_body_step(body, REAL(steps[s]), NULL));
        }
        found = mean_stress(body, &mesh, 0, 1);
        expected = rest * t;
        for (int i = 0; i < TERMS; i++)
            expected += g[i] * tau[i] * (1 - exp(-t / tau[i]));
        verify("shear growing evenly for 0.75 s, 4 uneven steps", element->name,
               "int g(t - s) ds = g_inf t + sum g_i tau_i (1 - exp(-t/tau_i))", "P_12/(mu rate) (s)", expected,
               found / (mu * rate), exact);
        verify_free(body, &mesh);
    }
}

/* ---- creep ---- */

/* A small shear under a traction that comes at once and stays, one term: gamma = s/mu (1/(1 - g) - g/(1 - g)
 * exp(-t/tau_c)), tau_c = tau/(1 - g). Steps take the stress to change evenly, which here is of second order.
 */
static void test_creep(void)
{
    static const double share = 0.5, time = 0.4, end = 1, traction = 1e-5;
    static const verify_plane top = {1, 1}, bottom = {1, 0};
    static const int steps[2] = {20, 40};
    double mu = verify_constants_of(young, poisson).mu, found[2], start = 0;
    double expected = 1 / (1 - share) - share / (1 - share) * exp(-end * (1 - share) / time);
    const verify_element *element = verify_element_named("hex8");
    sb_real g1 = REAL(share), tau1 = REAL(time);
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("small strains need double");
        return;
    }
    for (int k = 0; k < 2; k++) {
        sb_mesh mesh = verify_box(SB_HEX8, 1, 2, 1, 1, 1, 1);
        sb_material material = verify_materials[5].make(REAL(young), REAL(poisson), REAL(1e-9));
        sb_body *body = make_body(&mesh, element, sb_material_with_prony(material, &g1, &tau1, 1));
        sb_vec3 shear = sb_v3(REAL(traction * mu), 0, 0);
        for (int i = 0; i < mesh.node_count; i++)
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, verify_on_plane(&bottom, mesh.nodes[i]) ? SB_XYZ : SB_Y | SB_Z));
        verify_load(body, &mesh, verify_on_plane, &top, verify_uniform, &shear);
        solve(body, 1);
        start = (double)verify_mean(body, &mesh, verify_on_plane, &top).x / traction;
        for (int s = 0; s < steps[k]; s++)
            CHECK_OK(sb_body_step(body, REAL(end / steps[k]), NULL));
        found[k] = (double)verify_mean(body, &mesh, verify_on_plane, &top).x / traction;
        verify_free(body, &mesh);
    }
    verify("creep of one term, g = 0.5, tau = 0.4 s, small shear", "hex8", "s/mu", "shear at once/(s/mu)", 1, start,
           exact);
    verify("creep of one term, g = 0.5, tau = 0.4 s, small shear, 40 steps", "hex8",
           "1/(1 - g) (1 - g exp(-(1 - g) t/tau))", "shear after 1 s/(s/mu)", expected, found[1], 3e-5);
    verify("creep of one term, g = 0.5, tau = 0.4 s, small shear, 20 and 40 steps", "hex8",
           "of second order in dt (Simo and Hughes 1998, 10.3)", "order in time", 2,
           log(fabs((found[0] - expected) / (found[1] - expected))) / log(2.0), 0.001);
}

/* ---- storage and loss ---- */

/* mu (g_inf + sum g_i (w tau)^2/(1 + (w tau)^2)) and mu sum g_i w tau/(1 + (w tau)^2) */
static void dynamic_moduli(double w, double moduli[2])
{
    moduli[0] = 1;
    moduli[1] = 0;
    for (int i = 0; i < TERMS; i++) {
        double x = w * tau[i];
        moduli[0] -= g[i] / (1 + x * x);
        moduli[1] += g[i] * x / (1 + x * x);
    }
}

/* Fourier components of the stress over the last of `periods` of a small shear sin(w t). */
static void measure_moduli(double w, int periods, int per_period, double moduli[2])
{
    static const double size = 1e-5;
    sb_mesh mesh = verify_box(SB_TET4, 1, 1, 1, 1, 1, 1);
    sb_body *body = make_body(&mesh, verify_elements, relaxing(verify_materials + 5));
    double dt = 2 * VERIFY_PI / (w * per_period), mu = verify_constants_of(young, poisson).mu;
    moduli[0] = moduli[1] = 0;
    for (int s = 1; s <= periods * per_period; s++) {
        double phase = 2 * VERIFY_PI * s / per_period;
        const double G[3][3] = {{1, size * sin(phase), 0}, {0, 1, 0}, {0, 0, 1}};
        move_surface(body, &mesh, G);
        CHECK_OK(sb_body_step(body, REAL(dt), NULL));
        if (s > (periods - 1) * per_period) {
            double stress = mean_stress(body, &mesh, 0, 1) / (mu * size) * 2 / per_period;
            moduli[0] += stress * sin(phase);
            moduli[1] += stress * cos(phase);
        }
    }
    verify_free(body, &mesh);
}

static void test_moduli(void)
{
    static const double frequencies[3] = {0.5, 4, 30}, bounds[3] = {0.004, 0.003, 0.003};
    static const int periods[3] = {3, 8, 50};
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("small strains need double");
        return;
    }
    for (int k = 0; k < 3; k++) {
        double expected[2], found[2];
        char name[80];
        dynamic_moduli(frequencies[k], expected);
        measure_moduli(frequencies[k], periods[k], 48, found);
        snprintf(name, sizeof name, "small shear sin(w t), w = %g/s, 48 steps per period", frequencies[k]);
        verify(name, "tet4, neo_hookean_isochoric", "Ferry 1980: g_inf + sum g_i (w tau)^2/(1 + (w tau)^2)",
               "storage modulus/mu", expected[0], found[0], bounds[k]);
        verify(name, "tet4, neo_hookean_isochoric", "Ferry 1980: sum g_i w tau/(1 + (w tau)^2)", "loss modulus/mu",
               expected[1], found[1], bounds[k]);
    }
}

/* ---- limits ---- */

typedef struct lateral {
    const verify_material *material;
    double share, axial;
} lateral;

static double lateral_stress(const void *user, double side)
{
    const lateral *c = (const lateral *)user;
    double l[3], stress[3];
    l[0] = c->axial;
    l[1] = l[2] = side;
    c->material->principal(constants_at(c->share), l, stress);
    return stress[2];
}

/* Force on the unit cube pulled to 1.3 with free sides, and its side stretch. */
static void pull(const verify_element *element, const verify_material *material, int instantaneous, double found[2])
{
    static const double axial = 1.3;
    static const verify_plane ends[2] = {{0, 1}, {1, 1}};
    sb_mesh mesh = distorted_cube(element->type);
    sb_body *body = make_body(&mesh, element, relaxing(material));
    for (int axis = 0; axis < 3; axis++)
        scene_fix_plane(body, &mesh, axis, 0, 1 << axis);
    verify_move(body, &mesh, verify_on_plane, ends, SB_X, sb_v3(REAL(axial - 1), 0, 0));
    solve(body, instantaneous);
    found[0] = (double)verify_reaction(body, &mesh, verify_on_plane, ends).x;
    found[1] = 1 + (double)verify_mean(body, &mesh, verify_on_plane, ends + 1).y;
    verify_free(body, &mesh);
}

static void test_limits(void)
{
    for (int m = 0; m < VERIFY_MATERIALS; m++)
        for (int instantaneous = 0; instantaneous < 2 && relaxes(verify_materials + m); instantaneous++) {
            const char *name = instantaneous ? "uniaxial 1.3, static, at once" : "uniaxial 1.3, static, long after";
            const char *source = instantaneous ? "Ogden 1997, P_2 = P_3 = 0, with mu"
                                               : "Ogden 1997, P_2 = P_3 = 0, with K and mu (1 - sum g_i)";
            lateral c = {verify_materials + m, instantaneous ? 1 : 1 - g[0] - g[1], 1.3};
            double side = verify_root(lateral_stress, &c, 0.6, 1.1), worst[2] = {0, 0}, expected[2], stress[3];
            const double l[3] = {c.axial, side, side};
            c.material->principal(constants_at(c.share), l, stress);
            expected[0] = worst[0] = stress[0];
            expected[1] = worst[1] = side;
            for (int e = 0; e < VERIFY_ELEMENTS; e++) {
                double found[2];
                if (!verify_suits(verify_elements + e, SB_NEO_HOOKEAN))
                    continue;
                pull(verify_elements + e, c.material, instantaneous, found);
                for (int k = 0; k < 2; k++)
                    if (!(fabs(found[k] - expected[k]) <= fabs(worst[k] - expected[k])))
                        worst[k] = found[k];
            }
            verify(name, c.material->name, source, "force on a face of 1 m^2 (N)", expected[0], worst[0], exact);
            verify(name, c.material->name, source, "side stretch", expected[1], worst[1], exact);
        }
}

static void test_table(void) { verify_table("verification_viscoelastic"); }

CHECK_SUITE(verification_viscoelastic, {"relaxation", test_relaxation}, {"ramp", test_ramp}, {"creep", test_creep},
            {"storage and loss", test_moduli}, {"limits", test_limits}, {"table", test_table});
