/* Motion against closed forms: free flight, waves, impact, natural frequencies, damping, balance of energy
 * and momentum, for every integrator. Time is measured in steps whose own dispersion is known exactly where
 * the case name says so. */
#include "verification_scene.h"

static const double young = 1e4, density = 1000;

static sb_body *moving_body(const sb_mesh *mesh, const verify_element *element, sb_material material,
                            sb_integrator integrator, sb_mass_kind mass, double damping_mass, double damping_stiffness)
{
    sb_body_def def = verify_def(mesh, element, material);
    def.integrator = integrator;
    def.mass = mass;
    def.damping_mass = REAL(damping_mass);
    def.damping_stiffness = REAL(damping_stiffness);
    def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-6 : 1e-12);
    def.newton_tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-10);
    def.max_iterations = 5000;
    return scene_body(&def);
}

static void step(sb_body *body, double dt, int count)
{
    for (int s = 0; s < count; s++)
        if (!CHECK_OK(sb_body_step(body, REAL(dt), NULL)))
            return;
}

static void add_velocity(sb_body *body, const sb_mesh *mesh, sb_vec3 (*velocity)(sb_vec3 x))
{
    sb_vec3 *v = (sb_vec3 *)malloc((size_t)mesh->node_count * sizeof(sb_vec3));
    for (int i = 0; i < mesh->node_count; i++)
        v[i] = velocity(mesh->nodes[i]);
    CHECK_OK(sb_body_set_velocities(body, v));
    free(v);
}

/* ---- free flight ---- */

static sb_vec3 thrown(sb_vec3 x)
{
    (void)x;
    return sb_v3(3, 0, 4);
}

/* Rules of second order follow the parabola exactly, Euler falls g dt t/2 more than that. */
static void test_projectile(void)
{
    static const double gravity = 9.81, dt = 0.01;
    static const int steps = 50;
    static const struct {
        const char *name;
        sb_integrator integrator;
    } rules[] = {{"projectile, Euler", SB_EULER},
                 {"projectile, Newmark", SB_NEWMARK},
                 {"projectile, generalised alpha", SB_GENERALISED_ALPHA},
                 {"projectile, central difference", SB_CENTRAL_DIFFERENCE}};
    for (int e = 0; e < VERIFY_ELEMENTS; e++)
        for (int r = 0; r < 4; r++) {
            const verify_element *element = verify_elements + e;
            int euler = rules[r].integrator == SB_EULER;
            double t = steps * dt, height = 4 * t - gravity * t * t / 2;
            sb_mesh mesh = verify_box(element->type, 2, 2, 2, 0.1, 0.1, 0.1);
            sb_body *body = moving_body(&mesh, element, sb_material_corotated(REAL(young), REAL(0.3), REAL(density)),
                                        rules[r].integrator, SB_MASS_LUMPED, 0, 0);
            CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, REAL(-gravity))));
            add_velocity(body, &mesh, thrown);
            step(body, dt, steps);
            verify(rules[r].name, element->name, euler ? "v t - g t (t + dt)/2" : "v t - g t^2/2",
                   "height after 0.5 s (m)", euler ? height - gravity * t * dt / 2 : height,
                   (double)sb_body_displacements(body)[0].z, 1e-8);
            verify_free(body, &mesh);
        }
}

static sb_vec3 spinning(sb_vec3 x)
{
    return sb_v3_cross(sb_v3(0, 0, 10), sb_v3_sub(x, sb_v3(REAL(0.1), REAL(0.05), 0)));
}

static sb_vec3 angular_momentum(const sb_body *body, const sb_mesh *mesh)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int e = 0; e < mesh->element_count; e++) /* lumped, equal nodes of a hex8 */
        for (int a = 0; a < 8; a++) {
            int i = mesh->elements[8 * e + a];
            sum = sb_v3_add(sum, sb_v3_scale(sb_mesh_element_volume(mesh, e) * REAL(density / 8),
                                             sb_v3_cross(sb_body_positions(body)[i], sb_body_velocities(body)[i])));
        }
    return sum;
}

/* A bar that spins freely through about three turns. All rules keep the momentum; angular momentum central
 * difference keeps exactly, the others up to their own error. */
static void spin_case(const char *name, sb_integrator integrator, double bound)
{
    const verify_element *element = verify_element_named("hex8");
    sb_mesh mesh = verify_box(SB_HEX8, 4, 2, 2, 0.2, 0.1, 0.1);
    sb_body *body = moving_body(&mesh, element, sb_material_neo_hookean(REAL(1e5), REAL(0.3), REAL(density)),
                                integrator, SB_MASS_LUMPED, 0, 0);
    double before, momentum;
    add_velocity(body, &mesh, spinning);
    before = (double)angular_momentum(body, &mesh).z;
    momentum = (double)(sb_body_mass(body) * 10) * 0.1;
    step(body, 0.005, 400);
    verify(name, "hex8, neo_hookean", "L = const", "angular momentum (kg m^2/s)", before,
           (double)angular_momentum(body, &mesh).z, bound);
    verify(name, "hex8, neo_hookean", "p = 0", "momentum/(m w L/2)", 0,
           (double)sb_v3_norm(sb_body_momentum(body)) / momentum, 1e-8);
    verify_free(body, &mesh);
}

static void test_spin(void)
{
    spin_case("free spinning bar, 3 turns, Newmark dt = 5 ms, 4x2x2", SB_NEWMARK, 0.002);
    spin_case("free spinning bar, 3 turns, generalised alpha dt = 5 ms, 4x2x2", SB_GENERALISED_ALPHA, 0.0012);
    spin_case("free spinning bar, 3 turns, central difference dt <= 5 ms, 4x2x2", SB_CENTRAL_DIFFERENCE, 1e-8);
}

/* ---- one-dimensional columns: exact discrete modes ---- */

/* A column of n hex8 along x that can move along x (dilatation) or y (shear) only; clamped at x = 0. The
 * nodal values sin(k x), k = pi/(2 L), are an exact mode of the chain: w^2 = 4 M/(rho h^2) sin^2(k h/2), over
 * 1 - 2/3 sin^2(k h/2) with the consistent mass. */
static const int chain_cells = 16;

typedef struct chain {
    sb_mesh mesh;
    sb_body *body;
    double frequency; /* rad/s, of the discrete chain */
    int axis;
} chain;

static double chain_shape(double x) { return sin(VERIFY_PI * x / 2); }
static sb_vec3 chain_velocity_x(sb_vec3 x) { return sb_v3(REAL(0.01 * chain_shape((double)x.x)), 0, 0); }
static sb_vec3 chain_velocity_y(sb_vec3 x) { return sb_v3(0, REAL(0.01 * chain_shape((double)x.x)), 0); }

static chain make_chain(int axis, sb_integrator integrator, sb_mass_kind mass, double alpha, double beta)
{
    static const double poisson = 0.3;
    verify_constants c = verify_constants_of(young, poisson);
    double modulus = axis == 0 ? c.lambda + 2 * c.mu : c.mu, h = 1.0 / chain_cells, s = sin(VERIFY_PI * h / 4);
    chain made;
    made.axis = axis;
    made.mesh = verify_box(SB_HEX8, chain_cells, 1, 1, 1, h, h);
    made.body =
        moving_body(&made.mesh, verify_element_named("hex8"),
                    sb_material_linear(REAL(young), REAL(poisson), REAL(density)), integrator, mass, alpha, beta);
    for (int i = 0; i < made.mesh.node_count; i++)
        CHECK_OK(sb_body_fix_nodes(made.body, &i, 1, SB_XYZ & ~(1 << axis)));
    scene_fix_plane(made.body, &made.mesh, 0, 0, SB_XYZ);
    add_velocity(made.body, &made.mesh, axis == 0 ? chain_velocity_x : chain_velocity_y);
    made.frequency = 2 / h * s * sqrt(modulus / density);
    if (mass == SB_MASS_CONSISTENT)
        made.frequency /= sqrt(1 - 2.0 / 3 * s * s);
    return made;
}

static double chain_tip(const chain *c)
{
    int last = c->mesh.node_count - 1;
    for (int i = 0; i < c->mesh.node_count; i++)
        if (c->mesh.nodes[i].x > c->mesh.nodes[last].x)
            last = i;
    return (double)scene_component(sb_body_displacements(c->body)[last], c->axis);
}

/* Newmark's rule turns the frequency w into 2/dt atan(w dt/2) and keeps the amplitude v/w. */
static void test_chain_newmark(void)
{
    static const char *names[2] = {"dilatational mode of a column, 16 cells", "shear mode of a column, 16 cells"};
    for (int axis = 0; axis < 2; axis++)
        for (int consistent = 0; consistent < 2; consistent++) {
            static const int steps = 100;
            chain c = make_chain(axis, SB_NEWMARK, consistent ? SB_MASS_CONSISTENT : SB_MASS_LUMPED, 0, 0);
            double dt = 0.13 / c.frequency, w = 2 / dt * atan(c.frequency * dt / 2);
            step(c.body, dt, steps);
            verify(names[axis], consistent ? "hex8, consistent mass" : "hex8, lumped mass",
                   "exact discrete mode, Newmark 1959: w_h = 2/dt atan(w dt/2)", "tip after 100 steps (m)",
                   0.01 / c.frequency * sin(w * steps * dt), chain_tip(&c), 1e-8);
            verify_free(c.body, &c.mesh);
        }
}

/* Euler's rule: each step divides the complex amplitude by 1 - i w dt. */
static void test_chain_euler(void)
{
    static const int steps = 40;
    chain c = make_chain(0, SB_EULER, SB_MASS_LUMPED, 0, 0);
    double dt = 0.1 / c.frequency, wdt = c.frequency * dt;
    step(c.body, dt, steps);
    verify("dilatational mode of a column, 16 cells", "hex8, lumped mass",
           "exact discrete mode, implicit Euler: amplitude (1 + w^2 dt^2)^(-n/2), phase n atan(w dt)",
           "tip after 40 steps (m)", 0.01 / c.frequency * pow(1 + wdt * wdt, -steps / 2.0) * sin(steps * atan(wdt)),
           chain_tip(&c), 1e-8);
    verify_free(c.body, &c.mesh);
}

/* Central difference turns the frequency w into the w_h of sin(w_h dt/2) = w dt/2 and the amplitude v/w into
 * v dt/sin(w_h dt). */
static void test_chain_explicit(void)
{
    static const int steps = 100;
    for (int axis = 0; axis < 2; axis++) {
        chain c = make_chain(axis, SB_CENTRAL_DIFFERENCE, SB_MASS_LUMPED, 0, 0);
        double dt = (axis == 0 ? 0.04 : 0.02) / c.frequency, turn = 2 * asin(c.frequency * dt / 2);
        for (int s = 0; s < steps; s++) {
            sb_step_info info;
            CHECK_OK(sb_body_step(c.body, REAL(dt), &info));
            CHECK_INT(info.substeps, 1);
        }
        verify(axis ? "shear mode of a column, 16 cells" : "dilatational mode of a column, 16 cells",
               "hex8, lumped mass", "exact discrete mode, central difference: sin(w_h dt/2) = w dt/2",
               "tip after 100 steps (m)", 0.01 * dt / sin(turn) * sin(steps * turn), chain_tip(&c), 1e-8);
        verify_free(c.body, &c.mesh);
    }
}

/* Chung and Hulbert's rule for u'' + w^2 u = 0 from u = 0, v, written down here again; returns u after
 * `steps`. */
static double alpha_recursion(double radius, double w, double v, double dt, int steps)
{
    double am = (2 * radius - 1) / (radius + 1), af = radius / (radius + 1), gamma = 0.5 - am + af;
    double beta = 0.25 * (1 - am + af) * (1 - am + af), u = 0, a = 0;
    for (int s = 0; s < steps; s++) {
        double u0 = u + dt * v + dt * dt * (0.5 - beta) * a, v0 = v + dt * (1 - gamma) * a;
        double next = -(am * a + w * w * ((1 - af) * u0 + af * u)) / ((1 - am) + w * w * (1 - af) * beta * dt * dt);
        u = u0 + beta * dt * dt * next;
        v = v0 + gamma * dt * next;
        a = next;
    }
    return u;
}

static void test_chain_alpha(void)
{
    static const int steps = 60;
    static const double frequencies[2] = {0.13, 100};
    for (int k = 0; k < 2; k++) {
        char name[80];
        chain c = make_chain(0, SB_GENERALISED_ALPHA, SB_MASS_LUMPED, 0, 0);
        double dt = frequencies[k] / c.frequency, size = 0.01 / c.frequency;
        int count = k ? 6 : steps; /* while there is something left */
        step(c.body, dt, count);
        snprintf(name, sizeof name, "dilatational mode of a column, 16 cells, w dt = %g", frequencies[k]);
        verify(name, "hex8, lumped mass", "exact discrete mode, generalised alpha (Chung and Hulbert 1993), radius 0.5",
               k ? "tip after 6 steps/(v/w)" : "tip after 60 steps/(v/w)",
               alpha_recursion(0.5, c.frequency, 0.01, dt, count) / size, chain_tip(&c) / size, 1e-8);
        verify_free(c.body, &c.mesh);
    }
}

/* u'' + 2 a u' + w^2 u = 0 has the roots s = -a + i b; Newmark's rule steps by (1 + s dt/2)/(1 - s dt/2) for
 * exp(s dt): amplitude `size` and phase `turn` per step. */
static void damped_chain(const char *name, double alpha, double beta)
{
    static const int steps = 60;
    chain c = make_chain(0, SB_NEWMARK, SB_MASS_LUMPED, alpha, beta);
    double w = c.frequency, dt = 0.1 / w, a = (alpha + beta * w * w) / 2, b = sqrt(w * w - a * a);
    double p = b * dt / 2, q = a * dt / 2;
    double size = sqrt(((1 - q) * (1 - q) + p * p) / ((1 + q) * (1 + q) + p * p));
    double turn = atan2(p, 1 - q) + atan2(p, 1 + q);
    step(c.body, dt, steps);
    verify(name, "hex8, lumped mass", "Rayleigh 1877, 2 z w = alpha + beta w^2; exact under Newmark's rule",
           "tip after 60 steps (m)", 0.01 / b * pow(size, steps) * sin(steps * turn), chain_tip(&c), 1e-8);
    CHECK_NEAR(pow(size, steps), exp(-a * steps * dt), 0.01); /* and that is close to what is meant */
    verify_free(c.body, &c.mesh);
}

static void test_damping(void)
{
    damped_chain("column with mass damping, Newmark w dt = 0.1", 0.4, 0);
    damped_chain("column with stiffness damping, Newmark w dt = 0.1", 0, 0.02);
}

/* ---- waves ---- */

static sb_vec3 flying(sb_vec3 x)
{
    (void)x;
    return sb_v3(-1, 0, 0);
}

/* A bar that flies at 1 m/s into a wall, to which it sticks: the wall pushes with rho c v A until t = 2 L/c,
 * when the bar flies back. Poisson's ratio 0, c^2 = E/rho; the mean force of the first 2 L/c is the impulse 2
 * rho A L v. */
static void test_impact(void)
{
    static const int cells = 64, steps = 256;
    static const double length = 1;
    static const verify_plane wall = {0, 0};
    double c = sqrt(young / density), h = length / cells, t = 2 * length / c, impulse = 0, mean;
    sb_mesh mesh = verify_box(SB_HEX8, cells, 1, 1, length, h, h);
    sb_body *body = moving_body(&mesh, verify_element_named("hex8"), sb_material_linear(REAL(young), 0, REAL(density)),
                                SB_NEWMARK, SB_MASS_LUMPED, 0, 0);
    add_velocity(body, &mesh, flying);
    scene_fix_plane(body, &mesh, 0, 0, SB_X);
    for (int s = 0; s < steps; s++) {
        step(body, t / steps, 1);
        impulse += (double)verify_reaction(body, &mesh, verify_on_plane, &wall).x * t / steps;
    }
    mean = (double)sb_body_momentum(body).x / (density * length * h * h);
    verify("bar thrown against a wall, 64 cells, 256 Newmark steps", "hex8", "Saint-Venant 1867: 2 rho A L v",
           "impulse/(rho A L v)", 2, impulse / (density * length * h * h), 0.02);
    verify("bar thrown against a wall, 64 cells, 256 Newmark steps", "hex8", "Saint-Venant 1867: rebound at 2 L/c",
           "mean velocity/v", 1, mean, 0.05);
    verify_free(body, &mesh);
}

/* A bar fixed at x = 0, pulled at its end by a force that comes at once: its end moves at F c/(E A) until 2
 * L/c, when it is 2 F L/(E A) out, twice the static stretch, and is back at 4 L/c. */
static void test_step_response(void)
{
    static const int cells = 64, steps = 128;
    static const verify_plane end = {0, 1};
    static const char *source = "d'Alembert; Graff 1975, sec. 2.4: F c t/(E A), back from 2 L/c on";
    static const char *name = "bar loaded at once, 64 cells, 64 Newmark steps per L/c";
    double c = sqrt(young / density), h = 1.0 / cells, dt = 2 / c / steps;
    sb_mesh mesh = verify_box(SB_HEX8, cells, 1, 1, 1, h, h);
    sb_body *body = moving_body(&mesh, verify_element_named("hex8"), sb_material_linear(REAL(young), 0, REAL(density)),
                                SB_NEWMARK, SB_MASS_LUMPED, 0, 0);
    sb_vec3 pull = sb_v3(100, 0, 0);
    double unit = 100 / young;
    scene_fix_plane(body, &mesh, 0, 0, SB_X);
    verify_load(body, &mesh, verify_on_plane, &end, verify_uniform, &pull);
    step(body, dt, steps / 2);
    verify(name, "hex8", source, "end at L/c / (FL/EA)", 1,
           (double)verify_mean(body, &mesh, verify_on_plane, &end).x / unit, 1e-3);
    step(body, dt, steps / 2);
    verify(name, "hex8", source, "end at 2 L/c / (FL/EA)", 2,
           (double)verify_mean(body, &mesh, verify_on_plane, &end).x / unit, 0.03);
    step(body, dt, steps);
    verify(name, "hex8", source, "end at 4 L/c / (FL/EA)", 0,
           (double)verify_mean(body, &mesh, verify_on_plane, &end).x / unit, 0.08);
    verify_free(body, &mesh);
}

/* When a step of pressure or shear reaches the middle of a column. The front of a dispersive chain is Airy's
 * integral, which is a third of the plateau where d'Alembert's front is. */
static void wave_case(int axis, const char *name, const char *source)
{
    static const int cells = 100, steps = 200;
    static const double poisson = 0.3;
    static const verify_plane middle = {0, 0.5}, end = {0, 1};
    verify_constants k = verify_constants_of(young, poisson);
    double c = sqrt((axis == 0 ? k.lambda + 2 * k.mu : k.mu) / density), h = 1.0 / cells, dt = 1 / c / steps;
    double plateau = 0.1 / (density * c), arrival = 0, last = 0;
    sb_mesh mesh = verify_box(SB_HEX8, cells, 1, 1, 1, h, h);
    sb_body *body =
        moving_body(&mesh, verify_element_named("hex8"), sb_material_linear(REAL(young), REAL(poisson), REAL(density)),
                    SB_NEWMARK, SB_MASS_LUMPED, 0, 0);
    sb_vec3 push = axis == 0 ? sb_v3(REAL(0.1), 0, 0) : sb_v3(0, REAL(0.1), 0);
    for (int i = 0; i < mesh.node_count; i++)
        CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_XYZ & ~(1 << axis)));
    verify_load(body, &mesh, verify_on_plane, &end, verify_uniform, &push);
    for (int s = 1; s <= steps && arrival == 0; s++) {
        double speed = 0;
        step(body, dt, 1);
        for (int i = 0; i < mesh.node_count; i++)
            if (verify_on_plane(&middle, mesh.nodes[i]))
                speed = (double)scene_component(sb_body_velocities(body)[i], axis);
        if (speed > plateau / 3)
            arrival = (s - (speed - plateau / 3) / (speed - last)) * dt;
        last = speed;
    }
    verify(name, "hex8", source, "wave speed (m/s)", c, 0.5 / arrival, 0.001);
    verify_free(body, &mesh);
}

static void test_wave_speed(void)
{
    wave_case(0, "pressure wave, 100 cells, Courant number 1/2", "Love 1927: c^2 = (lambda + 2 mu)/rho");
    wave_case(1, "shear wave, 100 cells, Courant number 1/2", "Love 1927: c^2 = mu/rho");
}

/* ---- natural frequencies by stepping ---- */

/* Frequency (rad/s) of the first oscillation of the node nearest to the far end: zero crossings from the
 * second to the last of `steps`, with Newmark's dispersion taken out. */
static double measured_frequency(sb_body *body, const sb_mesh *mesh, sb_vec3 probe, int axis, double dt, int steps)
{
    double last = 0, first_crossing = 0, last_crossing = 0, w;
    int crossings = 0, node = 0;
    for (int i = 0; i < mesh->node_count; i++)
        if (sb_v3_norm(sb_v3_sub(mesh->nodes[i], probe)) < sb_v3_norm(sb_v3_sub(mesh->nodes[node], probe)))
            node = i;
    for (int s = 1; s <= steps; s++) {
        double now;
        step(body, dt, 1);
        now = (double)scene_component(sb_body_displacements(body)[node], axis);
        if (s > 1 && now * last < 0) {
            last_crossing = s - now / (now - last);
            if (crossings++ == 0)
                first_crossing = last_crossing;
        }
        last = now;
    }
    CHECK(crossings > 2);
    w = VERIFY_PI * (crossings - 1) / ((last_crossing - first_crossing) * dt);
    return 2 / dt * tan(w * dt / 2);
}

static sb_vec3 axial_mode(sb_vec3 x) { return sb_v3(REAL(1e-3 * chain_shape((double)x.x)), 0, 0); }

/* First bending mode of a cantilever of length 1, b = 1.8751. */
static sb_vec3 bending_mode(sb_vec3 x)
{
    static const double b = 1.8751040687119611;
    double s = (cosh(b) + cos(b)) / (sinh(b) + sin(b)), q = b * (double)x.x;
    return sb_v3(0, 0, REAL(1e-3 * (cosh(q) - cos(q) - s * (sinh(q) - sin(q)))));
}

static sb_vec3 torsion_mode(sb_vec3 x)
{
    sb_real a = REAL(1e-3 * chain_shape((double)x.x));
    return sb_v3(0, -a * x.z, a * x.y);
}

static void test_frequencies(void)
{
    static const double h = 0.05;
    static const char *elements[] = {"tet10", "hex8"};
    static const double bounds[][2] = {{3e-5, 1e-3}, {1.5e-4, -0.059}};
    for (int e = 0; e < 2; e++) {
        const verify_element *element = verify_element_named(elements[e]);
        int along = element->degree > 1 ? 10 : 40, across = element->degree > 1 ? 1 : 2;
        double c = sqrt(young / density), w;
        char name[80];
        for (int bending = 0; bending < 2; bending++) {
            sb_mesh mesh = verify_box(element->type, along, across, across, 1, h, h);
            sb_body *body = moving_body(&mesh, element, sb_material_linear(REAL(young), 0, REAL(density)), SB_NEWMARK,
                                        SB_MASS_CONSISTENT, 0, 0);
            scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
            add_velocity(body, &mesh, bending ? bending_mode : axial_mode);
            w = bending ? pow(1.8751040687119611, 2) * c * h / sqrt(12.0) : VERIFY_PI / 2 * c;
            snprintf(name, sizeof name, "%s of a clamped bar L/h = 20, %dx%dx%d",
                     bending ? "bending frequency" : "axial frequency", along, across, across);
            verify(name, elements[e],
                   bending ? "Euler-Bernoulli: 1.8751^2 (EI/rho A L^4)^(1/2)" : "pi/2 (E/rho L^2)^(1/2)",
                   "angular frequency (1/s)", w,
                   measured_frequency(body, &mesh, sb_v3(1, 0, 0), bending ? 2 : 0, 0.15 / w, 80), bounds[e][bending]);
            verify_free(body, &mesh);
        }
    }
}

static void test_torsional_frequency(void)
{
    static const double radius = 0.1, poisson = 0.3;
    double shear = young / (2 * (1 + poisson)), w = VERIFY_PI / 2 * sqrt(shear / density);
    sb_mesh mesh;
    sb_body *body;
    if (!CHECK_OK(sb_mesh_cylinder(SB_TET10, 0, REAL(radius), 1, 4, 8, NULL, &mesh, NULL)))
        return;
    verify_round(&mesh, radius);
    body =
        moving_body(&mesh, verify_element_named("tet10"), sb_material_linear(REAL(young), REAL(poisson), REAL(density)),
                    SB_NEWMARK, SB_MASS_CONSISTENT, 0, 0);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    add_velocity(body, &mesh, torsion_mode);
    verify("torsional frequency of a clamped round bar L/R = 10, 4 cells across, 8 along", "tet10",
           "pi/2 (G/rho L^2)^(1/2)", "angular frequency (1/s)", w,
           measured_frequency(body, &mesh, sb_v3(1, REAL(radius), 0), 2, 0.15 / w, 80), 0.015);
    verify_free(body, &mesh);
}

/* ---- swinging ---- */

/* A bar of length 1 that hangs on its edge x = 0, z = 0. */
static const double thickness = 0.1, gravity = 9.81;

static sb_vec3 swung(sb_vec3 x) { return sb_v3(REAL(0.05) * x.z, 0, REAL(-0.05) * x.x); }

/* Gravity points from the edge to the middle of the bar, turned by `angle`. */
static sb_body *pendulum(sb_mesh *mesh, double stiffness, double angle)
{
    double down = atan2(thickness, 1) + angle;
    sb_body *body;
    *mesh = verify_box(SB_HEX8, 10, 1, 1, 1, thickness, thickness);
    body = moving_body(mesh, verify_element_named("hex8"),
                       sb_material_corotated(REAL(stiffness), REAL(0.3), REAL(density)), SB_NEWMARK, SB_MASS_CONSISTENT,
                       0, 0);
    for (int i = 0; i < mesh->node_count; i++)
        if (mesh->nodes[i].x == 0 && mesh->nodes[i].z == 0)
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_XYZ));
    CHECK_OK(sb_body_set_gravity(body, sb_v3(REAL(gravity * cos(down)), 0, REAL(gravity * sin(down)))));
    return body;
}

/* Small swing of a stiff bar: w^2 = m g d/I, I = m (L^2 + h^2)/3, d = (L^2 + h^2)^(1/2)/2. */
static void test_pendulum(void)
{
    double square = 1 + thickness * thickness, w = sqrt(gravity * sqrt(square) / 2 / (square / 3));
    sb_mesh mesh;
    sb_body *body = pendulum(&mesh, 1e9, 0);
    add_velocity(body, &mesh, swung);
    verify("pendulum of E = 1 GPa, 0.01 rad, 10x1x1", "hex8, corotated", "Huygens 1673: (m g d/I)^(1/2)",
           "angular frequency (1/s)", w, measured_frequency(body, &mesh, sb_v3(1, 0, 0), 2, 0.1 / w, 200), 5e-4);
    verify_free(body, &mesh);
}

/* A soft bar let go from the horizontal: elastic, kinetic and gravity's energy stay 0 in sum. */
static void test_pendulum_energy(void)
{
    sb_mesh mesh;
    sb_body *body = pendulum(&mesh, 1e6, VERIFY_PI / 2);
    double scale = (double)sb_body_mass(body) * gravity / 2, worst = 0, most = 0;
    for (int s = 0; s < 200; s++) {
        sb_energy energy = {0, 0, 0};
        double sum;
        step(body, 0.005, 1);
        CHECK_OK(sb_body_energy(body, &energy));
        sum = (double)energy.elastic + (double)energy.kinetic;
        for (int i = 0; i < mesh.node_count; i++)
            sum -= (double)sb_v3_dot(sb_body_external_forces(body)[i], sb_body_displacements(body)[i]);
        most = fmax(most, (double)energy.kinetic);
        worst = verify_worse(worst, fabs(sum) / scale);
    }
    verify("bar of E = 1 MPa swinging from the horizontal, 1 s, Newmark dt = 5 ms", "hex8, corotated",
           "elastic + kinetic - m g . u = 0", "largest imbalance/(m g L/2)", 0, worst, 0.001);
    verify("bar of E = 1 MPa swinging from the horizontal, 1 s, Newmark dt = 5 ms", "hex8, corotated",
           "m g d: all of it kinetic at the lowest point", "largest kinetic energy/(m g d)", 1,
           most / (scale * sqrt(1 + thickness * thickness)), 0.012);
    verify_free(body, &mesh);
}

static void test_table(void) { verify_table("verification_dynamics"); }

CHECK_SUITE(verification_dynamics, {"projectile", test_projectile}, {"free spin", test_spin},
            {"chain under Newmark", test_chain_newmark}, {"chain under Euler", test_chain_euler},
            {"chain under central difference", test_chain_explicit},
            {"chain under generalised alpha", test_chain_alpha}, {"damping", test_damping}, {"impact", test_impact},
            {"step response", test_step_response}, {"wave speed", test_wave_speed}, {"frequencies", test_frequencies},
            {"torsional frequency", test_torsional_frequency}, {"pendulum", test_pendulum},
            {"energy of a pendulum", test_pendulum_energy}, {"table", test_table});
