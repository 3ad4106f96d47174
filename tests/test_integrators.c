/* Integrators side by side: orders in time on a nonlinear swing, what generalised alpha damps, what central
 * differences conserve, how the stable step compares with the true one, and what is refused or undone. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

static const sb_element_type element_types[] = {SB_TET4, SB_TET10, SB_HEX8};
enum { ELEMENT_TYPES = 3 };
static const char *const names[5] = {"", "Euler", "Newmark", "generalised alpha", "central difference"};

static double total_energy(sb_body *body)
{
    sb_energy energy;
    CHECK_OK(sb_body_energy(body, &energy));
    return (double)energy.elastic + (double)energy.kinetic;
}

/* Of the loads, up to a constant. */
static double potential_energy(const sb_body *body, int n)
{
    double sum = 0;
    for (int i = 0; i < n; i++)
        sum -= (double)sb_v3_dot(sb_body_external_forces(body)[i], sb_body_displacements(body)[i]);
    return sum;
}

/* ---- orders in time ---- */

enum { SWING_NODES = 8 };

/* A neo-Hookean beam, clamped, let go under gravity: the last nodes after 0.2 s; Newton iterations per step. */
static double swing(sb_integrator integrator, int steps, sb_vec3 *tip)
{
    sb_mesh mesh = scene_box(SB_HEX8, 5, 1, 1, sb_v3(REAL(0.1), REAL(0.02), REAL(0.02)), 0);
    sb_body_def def = sb_default_body_def();
    sb_step_info info;
    sb_body *body;
    int newton = 0;
    def.mesh = &mesh;
    def.material = sb_material_neo_hookean(REAL(1e4), REAL(0.3), REAL(1000));
    def.integrator = integrator;
    def.spectral_radius = REAL(0.5);
    def.gravity = sb_v3(0, 0, -3);
    def.damping_mass = 1;
    def.newton_tolerance = REAL(1e-11);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int s = 0; s < steps; s++) {
        if (!CHECK_OK(sb_body_step(body, REAL(0.2) / REAL(steps), &info)))
            printf("%s\n", info.error.message);
        CHECK_INT(info.capped, 0);
        CHECK_INT(info.substeps, integrator == SB_CENTRAL_DIFFERENCE);
        CHECK(info.load_factor == 1 && info.load_steps == 1);
        newton += info.newton_iterations;
    }
    for (int i = 0; i < SWING_NODES; i++)
        tip[i] = sb_body_displacements(body)[mesh.node_count - 1 - i];
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return (double)newton / (double)steps;
}

static void test_orders(void)
{
    static const double order[5] = {0, 1, 2, 2, 2}, most_newton[5] = {0, 5, 5, 5, 0};
    static const int first[5] = {0, 600, 80, 100, 400};
    sb_vec3 limit[SWING_NODES];
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("orders in time need double");
        return;
    }
    memset(limit, 0, sizeof limit);
    for (int k = SB_NEWMARK; k <= SB_CENTRAL_DIFFERENCE + 1; k++) { /* Euler last: its limit is the least sharp */
        sb_integrator integrator = k > SB_CENTRAL_DIFFERENCE ? SB_EULER : (sb_integrator)k;
        sb_vec3 tip[3][SWING_NODES], best[SWING_NODES];
        double newton = 0, coarse, fine, measured, power = pow(2, order[integrator]);
        for (int r = 0; r < 3; r++)
            newton = fmax(newton, swing(integrator, first[integrator] << r, tip[r]));
        coarse = scene_distance(tip[0], tip[1], SWING_NODES);
        fine = scene_distance(tip[1], tip[2], SWING_NODES);
        measured = log(coarse / fine) / log(2.0);
        for (int i = 0; i < SWING_NODES; i++) /* Richardson */
            best[i] = sb_v3_madd(tip[2][i], REAL(1 / (power - 1)), sb_v3_sub(tip[2][i], tip[1][i]));
        if (integrator == SB_NEWMARK)
            memcpy(limit, best, sizeof limit);
        printf("  order in time, %s: %.3f, %.2f Newton per step, limits %.1e of %.3f m apart\n", names[integrator],
               measured, newton, scene_distance(best, limit, SWING_NODES), (double)sb_v3_norm(limit[0]));
        CHECK_NEAR(measured, order[integrator], 0.1);
        CHECK(newton <= most_newton[integrator]);
        CHECK_NEAR(scene_distance(best, limit, SWING_NODES), 0, 1e-3 * (double)sb_v3_norm(limit[0]));
    }
}

/* ---- generalised alpha ---- */

/* A linear block on a plane, stepped far above what dt resolves. */
static sb_body *stiff_block(sb_mesh *mesh, double radius)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    *mesh = scene_box(SB_TET4, 2, 2, 2, sb_v3(1, 1, 1), 0.1);
    def.mesh = mesh;
    def.material = sb_material_linear(1000, REAL(0.3), 1000);
    def.integrator = SB_GENERALISED_ALPHA;
    def.spectral_radius = REAL(radius);
    def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-6 : 1e-13);
    body = scene_body(&def);
    scene_fix_plane(body, mesh, 2, 0, SB_XYZ);
    return body;
}

/* The displacements of a linear scheme with three state variables obey u[n+3] = c0 u[n+2] + c1 u[n+1] + c2 u[n]: finds
 * c from six of them (Cramer). */
static void recurrence(const double *u, double c[3])
{
    double a[3][3], det = 0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            a[i][j] = u[i + 2 - j];
    for (int j = 0; j < 3; j++)
        det += a[0][j] * (a[1][(j + 1) % 3] * a[2][(j + 2) % 3] - a[1][(j + 2) % 3] * a[2][(j + 1) % 3]);
    for (int k = 0; k < 3; k++) {
        double replaced = 0;
        for (int i = 0; i < 3; i++)
            replaced += u[i + 3] * (a[(i + 1) % 3][(k + 1) % 3] * a[(i + 2) % 3][(k + 2) % 3] -
                                    a[(i + 1) % 3][(k + 2) % 3] * a[(i + 2) % 3][(k + 1) % 3]);
        c[k] = replaced / det;
    }
}

/* Far above what dt resolves all three roots of the scheme are -rho: c = -(3 rho, 3 rho^2, rho^3), for every node. */
static void test_spectral_radius(void)
{
    static const double radii[5] = {1, 0.8, 0.5, 0.2, 0};
    for (int k = 0; k < 5; k++) {
        sb_mesh mesh;
        double rho = radii[k], u[6], c[3], tolerance = scene_tolerance(1e-6, 1e4);
        sb_body *body = stiff_block(&mesh, rho);
        int n = mesh.node_count;
        sb_vec3 start[27];
        memset(start, 0, sizeof start);
        for (int i = 0; i < n; i++)
            if (!sb_body_supports(body)[i])
                start[i] = sb_v3(REAL(0.001), REAL(-0.002) * mesh.nodes[i].x, REAL(0.01) * mesh.nodes[i].z);
        CHECK_OK(sb_body_set_displacements(body, start)); /* the lowest omega is about 1 /s */
        for (int s = 0; s < 6; s++) {
            u[s] = (double)sb_body_displacements(body)[n - 1].z;
            CHECK_OK(sb_body_step(body, REAL(1e5), NULL));
        }
        if (rho == 0) { /* gone as soon as the start is forgotten */
            CHECK_NEAR(u[4] / u[0], 0, 10 * tolerance);
        } else if (rho == 1) { /* kept for good */
            for (int s = 0; s < 6; s++)
                CHECK_NEAR(u[s] / u[0], s % 2 ? -1 : 1, 10 * tolerance);
        } else {
            recurrence(u, c);
            printf("  spectral radius %.1f: %.8f\n", rho, cbrt(-c[2]));
            CHECK_NEAR(cbrt(-c[2]), rho, 10 * tolerance);
            CHECK_NEAR(c[0], -3 * rho, 100 * tolerance);
            CHECK_NEAR(c[1], -3 * rho * rho, 100 * tolerance);
        }
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* A linear beam, struck: the energy never exceeds what it began with, and at spectral radius 1 stays. */
static void test_alpha_never_gains(void)
{
    static const double radii[4] = {0, 0.5, 0.8, 1};
    for (int k = 0; k < 4; k++) {
        sb_mesh mesh = scene_box(SB_TET10, 4, 1, 1, sb_v3(REAL(0.2), REAL(0.05), REAL(0.05)), 0);
        sb_body_def def = sb_default_body_def();
        sb_vec3 *v = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof(sb_vec3));
        unsigned long long seed = 5;
        double first, most, last = 0;
        sb_body *body;
        def.mesh = &mesh;
        def.material = sb_material_linear(REAL(5e4), REAL(0.3), REAL(1000));
        def.integrator = SB_GENERALISED_ALPHA;
        def.spectral_radius = REAL(radii[k]);
        def.mass = SB_MASS_CONSISTENT;
        def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-6 : 1e-11);
        def.max_iterations = 2000;
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        for (int i = 0; i < mesh.node_count; i++)
            if (!sb_body_supports(body)[i])
                v[i] = sb_v3(REAL(check_random_in(&seed, -1, 1)), REAL(check_random_in(&seed, -1, 1)),
                             REAL(check_random_in(&seed, -1, 1)));
        CHECK_OK(sb_body_set_velocities(body, v));
        most = first = total_energy(body);
        for (int s = 0; s < 300; s++) {
            if (!CHECK_OK(sb_body_step(body, REAL(0.005), NULL)))
                break;
            last = total_energy(body);
            most = fmax(most, last);
        }
        printf("  spectral radius %.1f: %.6f of the energy at most, %.4f in the end\n", radii[k], most / first,
               last / first);
        CHECK_NEAR(most / first, 1, scene_tolerance(1e-8, 1e5));
        CHECK(radii[k] == 1 ? fabs(last / first - 1) < scene_tolerance(1e-7, 1e5) : last < 0.9 * first);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(v);
    }
}

/* Reactions and loads of generalised alpha balance M a and D v where the scheme has its balance. With A the rate of
 * momentum by the scheme's own rule P' = P + dt ((1 - gamma) A + gamma A'), in total: (1 - am) A' + am A. */
static void test_alpha_balance(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        sb_mesh mesh = scene_box(element_types[t], 4, 2, 2, sb_v3(REAL(0.1), REAL(0.05), REAL(0.05)), 0.1);
        sb_body_def def = sb_default_body_def();
        double rho = 0.6, inertia = (2 - rho) / (1 + rho), level = 1 / (1 + rho), gamma = 0.5 + inertia - level;
        double dt = 0.01, rate[3] = {0.3, 0, -9.81}, weight;
        sb_body *body;
        def.mesh = &mesh;
        def.material = sb_material_neo_hookean(REAL(5e3), REAL(0.4), REAL(1000));
        def.gravity = sb_v3(REAL(0.3), 0, REAL(-9.81));
        def.integrator = SB_GENERALISED_ALPHA;
        def.spectral_radius = REAL(rho);
        def.damping_stiffness = REAL(0.01);
        def.newton_tolerance = REAL(1e-11);
        def.max_iterations = 2000;
        body = scene_body(&def);
        weight = 9.81 * (double)sb_body_mass(body);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        for (int s = 0; s < 6; s++) {
            sb_vec3 before = sb_body_momentum(body), after, sum;
            CHECK_OK(sb_body_step(body, REAL(dt), NULL));
            after = sb_body_momentum(body);
            sum = sb_v3_add(scene_sum(sb_body_reactions(body), mesh.node_count),
                            scene_sum(sb_body_external_forces(body), mesh.node_count));
            for (int k = 0; k < 3; k++) {
                /* free nodes start with a = g, held ones with 0 */
                double change = (double)scene_component(sb_v3_sub(after, before), k) / dt, next, balance;
                if (s == 0) {
                    double moving = 0;
                    for (int i = 0; i < mesh.node_count; i++)
                        if (!sb_body_supports(body)[i])
                            moving +=
                                (double)sb_v3_norm(sb_body_external_forces(body)[i]) / (double)sb_v3_norm(def.gravity);
                    rate[k] *= moving;
                }
                next = (change - (1 - gamma) * rate[k]) / gamma;
                balance = inertia * next + (1 - inertia) * rate[k];
                rate[k] = next;
                CHECK_NEAR((double)scene_component(sum, k) / weight, balance / weight, scene_tolerance(1e-8, 1e4));
            }
        }
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* Free fall is exact from the first step on: the initial acceleration is solved for. Supports reach their targets to
 * the last bit, whatever share of the way the balance is at. */
static void test_alpha_follows(void)
{
    for (int k = 0; k <= 10; k += 5) {
        sb_mesh mesh = scene_box(SB_TET10, 2, 1, 1, sb_v3(REAL(0.2), REAL(0.1), REAL(0.1)), 0);
        sb_body_def def = sb_default_body_def();
        sb_body *body;
        def.mesh = &mesh;
        def.material = sb_material_neo_hookean(REAL(5e3), REAL(0.4), REAL(1000));
        def.integrator = SB_GENERALISED_ALPHA;
        def.spectral_radius = REAL(0.1 * k);
        def.gravity = sb_v3(0, 0, REAL(-9.81));
        body = scene_body(&def);
        for (int s = 1; s <= 10; s++) {
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
            CHECK_NEAR(sb_body_displacements(body)[mesh.node_count - 1].z, -0.5 * 9.81e-4 * s * s, 1e-5);
        }
        sb_body_reset(body);
        for (int s = 1; s <= 10; s++) {
            sb_vec3 target = sb_v3(REAL(0.0013) * REAL(s), REAL(-0.0007), REAL(0.0001) / REAL(s));
            for (int i = 0; i < mesh.node_count; i++)
                if (mesh.nodes[i].x == 0)
                    CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &target, 1));
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
            for (int i = 0; i < mesh.node_count; i++)
                if (mesh.nodes[i].x == 0) {
                    CHECK_NEAR(scene_distance(sb_body_displacements(body) + i, &target, 1), 0, 0);
                    CHECK_NEAR(sb_body_velocities(body)[i].x, 0.13, scene_tolerance(1e-10, 100));
                }
        }
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

typedef struct rough_ride {
    int failures;  /* steps undone */
    double energy; /* largest total, potential of gravity included, over the first */
} rough_ride;

/* A soft undamped beam that falls about its clamp, with steps that resolve little. */
static rough_ride fall_about(sb_integrator integrator, double radius, sb_material material)
{
    sb_mesh mesh = scene_box(SB_TET10, 6, 1, 1, sb_v3(REAL(0.3), REAL(0.06), REAL(0.06)), 0);
    sb_body_def def = sb_default_body_def();
    rough_ride ride = {0, 0};
    double height;
    sb_body *body;
    def.mesh = &mesh;
    def.material = material;
    def.integrator = integrator;
    def.spectral_radius = REAL(radius);
    def.mass = SB_MASS_CONSISTENT;
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    height = 9.81 * (double)sb_body_mass(body) * 0.3;
    for (int s = 0; s < 80; s++) {
        ride.failures += sb_body_step(body, REAL(0.02), NULL) != SB_OK;
        ride.energy = fmax(ride.energy, (total_energy(body) + potential_energy(body, mesh.node_count)) / height);
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return ride;
}

static void test_alpha_is_robust(void)
{
    sb_material material = sb_material_neo_hookean(REAL(4e3), REAL(0.45), REAL(1000));
    rough_ride newmark = fall_about(SB_NEWMARK, 1, material);
    rough_ride alpha = fall_about(SB_GENERALISED_ALPHA, 0.5, material);
    printf("  falling about, 80 steps: Newmark %d undone, energy gained %.3g m g L; generalised alpha %d, %.3g\n",
           newmark.failures, newmark.energy, alpha.failures, alpha.energy);
    CHECK_INT(alpha.failures, 0);
    CHECK(newmark.energy > 0.05 && alpha.energy < 1e-3);
}

/* The balance may lie in an admissible shape and the end of the step not: then the step is done with its balance at
 * the end, and when that does not help either it is undone. */
static void test_alpha_survives_inversion(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 2, 2, 2, sb_v3(1, 1, 1), 0);
    sb_body_def def = sb_default_body_def();
    size_t bytes = (size_t)mesh.node_count * sizeof(sb_vec3);
    sb_vec3 *v = (sb_vec3 *)calloc(1, bytes), *u = (sb_vec3 *)malloc(bytes);
    sb_step_info info;
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_neo_hookean(REAL(100), REAL(0.3), REAL(1000));
    def.integrator = SB_GENERALISED_ALPHA;
    def.spectral_radius = 1;
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 2, 0, SB_XYZ);
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    for (int i = 0; i < mesh.node_count; i++)
        v[i].z = -5 * mesh.nodes[i].z;
    CHECK_OK(sb_body_set_velocities(body, v));
    CHECK_OK(sb_body_step(body, REAL(0.3), &info));
    CHECK(total_energy(body) > 0); /* every element is admissible */
    memcpy(u, sb_body_displacements(body), bytes);
    memcpy(v, sb_body_velocities(body), bytes);
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].z > REAL(0.999)) {
            sb_vec3 through = sb_v3(0, 0, -3);
            CHECK_OK(sb_body_prescribe(body, &i, 1, SB_Z, &through, 1));
        }
    CHECK(sb_body_step(body, REAL(0.3), &info) != SB_OK);
    CHECK(info.error.message[0] && memcmp(u, sb_body_displacements(body), bytes) == 0);
    CHECK(memcmp(v, sb_body_velocities(body), bytes) == 0);
    for (int i = 0; i < mesh.node_count; i++)
        if (mesh.nodes[i].z > REAL(0.999))
            CHECK_OK(sb_body_release_nodes(body, &i, 1, SB_Z));
    CHECK_OK(sb_body_step(body, REAL(0.01), &info));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(u);
    free(v);
}

/* ---- the stable step ---- */

/* A body all of whose nodes are supported: its reactions are the internal forces of any shape. */
typedef struct probe {
    sb_mesh mesh;
    sb_body *body;
    int *all;
    double *mass; /* lumped (kg) */
    sb_vec3 *u, *x, *y, *z;
} probe;

static probe make_probe(sb_element_type type, sb_material material)
{
    probe p;
    sb_body_def def = sb_default_body_def();
    int n;
    memset(&p, 0, sizeof p);
    p.mesh = scene_box(type, 3, 2, 2, sb_v3(REAL(0.12), REAL(0.08), REAL(0.08)), 0.3);
    n = p.mesh.node_count;
    def.mesh = &p.mesh;
    def.material = material;
    def.gravity = sb_v3(1, 0, 0);
    p.body = scene_body(&def);
    p.all = (int *)malloc((size_t)n * sizeof(int));
    p.mass = (double *)malloc((size_t)n * sizeof(double));
    p.u = (sb_vec3 *)calloc(4 * (size_t)n, sizeof(sb_vec3));
    p.x = p.u + n;
    p.y = p.x + n;
    p.z = p.y + n;
    for (int i = 0; i < n; i++)
        p.all[i] = i;
    CHECK_OK(sb_body_fix_nodes(p.body, p.all, n, SB_XYZ));
    CHECK_OK(sb_body_step(p.body, REAL(0.01), NULL));
    for (int i = 0; i < n; i++)
        p.mass[i] = (double)sb_body_external_forces(p.body)[i].x;
    CHECK_OK(sb_body_set_gravity(p.body, sb_v3(0, 0, 0)));
    return p;
}

static void free_probe(probe *p)
{
    sb_body_destroy(p->body);
    sb_mesh_free(&p->mesh);
    free(p->all);
    free(p->mass);
    free(p->u);
}

static void probe_force(probe *p, double step, sb_vec3 *out)
{
    int n = p->mesh.node_count;
    for (int i = 0; i < n; i++)
        p->z[i] = sb_v3_madd(p->u[i], REAL(step), p->x[i]);
    CHECK_OK(sb_body_prescribe(p->body, p->all, n, SB_XYZ, p->z, 0));
    CHECK_OK(sb_body_solve_static(p->body, NULL, NULL));
    memcpy(out, sb_body_reactions(p->body), (size_t)n * sizeof(sb_vec3));
}

/* 2 / omega_max by power iteration, K x by central differences of forces: from below omega_max. */
static double true_stable_step(probe *p, int iterations)
{
    int n = p->mesh.node_count;
    sb_vec3 *forward = (sb_vec3 *)malloc((size_t)n * sizeof(sb_vec3));
    unsigned long long seed = 17;
    double square = 0;
    for (int i = 0; i < n; i++)
        p->x[i] = sb_v3(REAL(check_random_in(&seed, -1, 1)), REAL(check_random_in(&seed, -1, 1)),
                        REAL(check_random_in(&seed, -1, 1)));
    for (int k = 0; k < iterations; k++) {
        double norm = 0, largest = 0, along = 0, mass = 0, step;
        for (int i = 0; i < n; i++)
            largest = fmax(largest, (double)sb_v3_norm(p->x[i]));
        step = 1e-6 / largest; /* of elements of 4 cm */
        probe_force(p, step, forward);
        probe_force(p, -step, p->y);
        for (int i = 0; i < n; i++) {
            sb_vec3 kx = sb_v3_scale(REAL(0.5 / step), sb_v3_sub(forward[i], p->y[i]));
            along += (double)sb_v3_dot(p->x[i], kx);
            mass += p->mass[i] * (double)sb_v3_dot(p->x[i], p->x[i]);
            p->y[i] = sb_v3_scale(REAL(1 / p->mass[i]), kx);
            norm = fmax(norm, (double)sb_v3_norm(p->y[i]));
        }
        square = along / mass;
        for (int i = 0; i < n; i++)
            p->x[i] = sb_v3_scale(REAL(1 / norm), p->y[i]);
    }
    free(forward);
    return 2 / sqrt(square);
}

static void test_stable_step(void)
{
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("differences of forces need double");
        return;
    }
    for (int t = 0; t < ELEMENT_TYPES; t++)
        for (int m = 0; m < 4; m++) {
            sb_material materials[4];
            sb_real dt = 0, again = 0;
            sb_error error;
            double ratio;
            probe p;
            materials[0] = sb_material_linear(REAL(5e3), REAL(0.3), REAL(1000));
            materials[1] = sb_material_linear(REAL(5e3), REAL(0.49), REAL(1000));
            materials[2] = sb_material_corotated(REAL(5e3), REAL(0.45), REAL(1000));
            materials[3] = sb_material_neo_hookean(REAL(5e3), REAL(0.45), REAL(1000));
            p = make_probe(element_types[t], materials[m]);
            for (int i = 0; i < p.mesh.node_count && m > 1; i++) /* squeezed by 30 %, sheared, and turned */
                p.u[i] = sb_v3(REAL(-0.3) * p.mesh.nodes[i].x, REAL(0.3) * p.mesh.nodes[i].z, p.mesh.nodes[i].x);
            CHECK_OK(sb_body_set_displacements(p.body, p.u));
            CHECK_OK(sb_body_stable_step(p.body, &dt, &error));
            CHECK_OK(sb_body_stable_step(p.body, &again, NULL));
            CHECK(dt == again);
            ratio = (double)dt / true_stable_step(&p, 40);
            printf("  stable step %s, model %d: %.4g s, %.3f of the true one\n", sb_element_name(element_types[t]),
                   (int)materials[m].model, (double)dt, ratio);
            CHECK(ratio <= 1 && ratio > 0.75);
            free_probe(&p);
        }
}

/* ---- central differences ---- */

/* Cells of 5 cm, `length` by 2 by `height` of them. */
static sb_body *explicit_beam(sb_mesh *mesh, sb_element_type type, int length, int height, sb_material material)
{
    sb_body_def def = sb_default_body_def();
    *mesh = scene_box(type, length, 2, height, sb_v3(REAL(0.05 * length), REAL(0.1), REAL(0.05 * height)), 0.1);
    def.mesh = mesh;
    def.material = material;
    def.integrator = SB_CENTRAL_DIFFERENCE;
    return scene_body(&def);
}

static void test_explicit_conserves(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        sb_mesh mesh;
        sb_body *body =
            explicit_beam(&mesh, element_types[t], 2, 1, sb_material_linear(REAL(5e3), REAL(0.4), REAL(1000)));
        sb_vec3 *v = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof(sb_vec3)), before, after;
        unsigned long long seed = 21;
        double first, least = 1e30, most = 0, size = 0;
        sb_real dt = 0;
        for (int i = 0; i < mesh.node_count; i++) {
            v[i] = sb_v3(REAL(check_random_in(&seed, -0.1, 0.2)), REAL(check_random_in(&seed, -0.1, 0.1)),
                         REAL(check_random_in(&seed, -0.1, 0.1)));
            size += (double)sb_v3_norm(v[i]) / mesh.node_count;
        }
        CHECK_OK(sb_body_set_velocities(body, v));
        CHECK_OK(sb_body_stable_step(body, &dt, NULL));
        first = total_energy(body);
        before = sb_body_momentum(body);
        for (int s = 0; s < 10000; s++) {
            if (!CHECK_OK(sb_body_step(body, REAL(0.5) * dt, NULL)))
                break;
            if (s % 50 == 0) {
                double energy = total_energy(body);
                least = fmin(least, energy);
                most = fmax(most, energy);
            }
        }
        after = sb_body_momentum(body);
        printf(
            "  explicit %s, 10,000 steps of half the stable one: energy between %.4f and %.4f, momentum off by %.1e\n",
            sb_element_name(element_types[t]), least / first, most / first,
            (double)sb_v3_norm(sb_v3_sub(after, before)) / (size * (double)sb_body_mass(body)));
        CHECK(least > 0.8 * first && most < 1.25 * first);
        CHECK_NEAR((double)sb_v3_norm(sb_v3_sub(after, before)) / (size * (double)sb_body_mass(body)), 0,
                   1e4 * (double)SB_EPSILON);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(v);
    }
}

/* Frames of a trainer: substeps are counted, supports are where they belong, and in the end reactions carry the
 * weight. */
static void test_explicit_frames(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++)
        for (int corotated = 0; corotated < 2; corotated++) {
            sb_mesh mesh;
            sb_body *body = explicit_beam(&mesh, element_types[t], 3, 1,
                                          corotated ? sb_material_corotated(REAL(2e4), REAL(0.4), REAL(1000))
                                                    : sb_material_neo_hookean(REAL(2e4), REAL(0.4), REAL(1000)));
            sb_vec3 target = sb_v3(REAL(0.01), 0, REAL(0.02));
            sb_step_info info;
            sb_real dt = 0;
            double weight = 9.81 * (double)sb_body_mass(body);
            CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, REAL(-9.81))));
            CHECK_OK(sb_body_set_damping(body, 20, 0));
            for (int i = 0; i < mesh.node_count; i++)
                if (mesh.nodes[i].x == 0)
                    CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &target, 1));
            CHECK_OK(sb_body_stable_step(body, &dt, NULL));
            for (int frame = 0; frame < 90; frame++) {
                if (!CHECK_OK(sb_body_step(body, REAL(1.0 / 60), &info))) {
                    printf("%s\n", info.error.message);
                    break;
                }
                if (frame == 0)
                    CHECK_INT(info.substeps, (int)ceil(1.0 / 60 / (0.9 * (double)dt)));
                CHECK(info.substeps > 1 && info.load_factor == 1 && info.newton_iterations == 0);
                for (int i = 0; i < mesh.node_count; i++)
                    if (mesh.nodes[i].x == 0) {
                        CHECK_NEAR(scene_distance(sb_body_displacements(body) + i, &target, 1), 0, 0);
                        CHECK_NEAR(sb_body_velocities(body)[i].z, frame == 0 ? 1.2 : 0, 1e-5);
                    }
            }
            CHECK_NEAR(scene_sum(sb_body_reactions(body), mesh.node_count).z / REAL(weight), 1, 2e-3);
            CHECK_NEAR(scene_sum(sb_body_external_forces(body), mesh.node_count).z / REAL(weight), -1, 1e-5);
            sb_body_destroy(body);
            sb_mesh_free(&mesh);
        }
}

/* The limit is real: a hair's breadth of tissue that is hard next to soft, driven through itself, thrown about. */
static void test_explicit_violence(void)
{
    for (int m = 0; m < 3; m++)
        for (int t = 0; t < ELEMENT_TYPES; t++) {
            sb_material materials[3];
            sb_mesh mesh;
            sb_body *body;
            int failures = 0, substeps = 0;
            double after_jerks = 0, last = 0;
            unsigned long long seed = 1234;
            materials[0] = sb_material_corotated(REAL(5e3), REAL(0.4), REAL(1000));
            materials[1] = sb_material_stable_neo_hookean(REAL(5e3), REAL(0.4), REAL(1000));
            materials[2] = sb_material_neo_hookean(REAL(5e3), REAL(0.4), REAL(1000));
            body = explicit_beam(&mesh, element_types[t], 2, 2, materials[m]);
            CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, REAL(-9.81))));
            CHECK_OK(sb_body_set_damping(body, 2, 0));
            scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
            for (int s = 0; s < 60; s++) {
                int tool = (int)(check_random(&seed) * mesh.node_count);
                sb_step_info info;
                if (s % 10 == 0 && s < 40 && mesh.nodes[tool].x > 0) {
                    sb_vec3 jerk =
                        sb_v3_add(sb_body_displacements(body)[tool], sb_v3(REAL(check_random_in(&seed, -0.1, 0.1)),
                                                                           REAL(check_random_in(&seed, -0.1, 0.1)),
                                                                           REAL(check_random_in(&seed, -0.1, 0.1))));
                    CHECK_OK(sb_body_prescribe(body, &tool, 1, SB_XYZ, &jerk, 1));
                    failures += sb_body_step(body, REAL(1.0 / 60), &info) != SB_OK;
                    CHECK_OK(sb_body_release_nodes(body, &tool, 1, SB_XYZ));
                }
                failures += sb_body_step(body, REAL(1.0 / 60), &info) != SB_OK;
                substeps += info.substeps;
                last = total_energy(body) + potential_energy(body, mesh.node_count);
                after_jerks = s == 40 ? last : after_jerks;
                if (!CHECK(scene_all_finite(sb_body_positions(body), mesh.node_count) &&
                           scene_all_finite(sb_body_velocities(body), mesh.node_count)))
                    break;
            }
            printf("  explicit violence %s, model %d: %d of 64 steps undone, %.0f substeps per frame, %.2f of the "
                   "energy left\n",
                   sb_element_name(element_types[t]), (int)materials[m].model, failures, substeps / 64.0,
                   last / after_jerks);
            CHECK(last <= after_jerks); /* nothing came in since, and damping took some */
            if (m < 2)
                CHECK_INT(failures, 0);
            else
                CHECK(failures <= 4); /* jerks through other elements, which ln J does not admit */
            sb_body_destroy(body);
            sb_mesh_free(&mesh);
        }
}

/* A scene in which step number fail_at (from 1; 0: none) is preceded by one that fails: the hash of its end. */
static unsigned long long play_with_failure(sb_integrator integrator, int corotated, int fail_at, sb_jobs jobs)
{
    sb_mesh mesh = scene_box(corotated ? SB_TET10 : SB_TET4, 3, 2, 2, sb_v3(REAL(0.15), REAL(0.1), REAL(0.1)), 0.1);
    sb_body_def def = sb_default_body_def();
    unsigned long long hash;
    sb_real dt;
    sb_body *body;
    def.mesh = &mesh;
    def.material = corotated ? sb_material_corotated(REAL(5e3), REAL(0.4), REAL(1000))
                             : sb_material_neo_hookean(REAL(5e3), REAL(0.4), REAL(1000));
    def.gravity = sb_v3(0, REAL(1), REAL(-9.81));
    def.integrator = integrator;
    def.damping_mass = 1;
    def.jobs = jobs;
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int s = 1; s <= 8; s++) {
        if (s == fail_at) {
            size_t bytes = (size_t)mesh.node_count * sizeof(sb_vec3);
            sb_vec3 *r = (sb_vec3 *)malloc(bytes);
            sb_step_info info;
            memcpy(r, sb_body_reactions(body), bytes);
            CHECK_OK(sb_body_set_gravity(body, sb_v3(0, 0, SB_REAL_MAX / 2)));
            CHECK(sb_body_step(body, REAL(0.01), &info) != SB_OK);
            CHECK(info.error.message[0] && info.error.result != SB_OK && info.load_factor == 0);
            CHECK(memcmp(r, sb_body_reactions(body), bytes) == 0);
            CHECK_OK(sb_body_set_gravity(body, def.gravity));
            CHECK_OK(sb_body_stable_step(body, &dt, NULL)); /* a question must not change the answer */
            free(r);
        }
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    }
    hash = scene_hash(sb_body_displacements(body), (size_t)mesh.node_count * sizeof(sb_vec3)) ^
           scene_hash(sb_body_velocities(body), (size_t)mesh.node_count * sizeof(sb_vec3)) ^
           scene_hash(sb_body_reactions(body), (size_t)mesh.node_count * sizeof(sb_vec3));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return hash;
}

/* ---- steps of another length ---- */

/* A beam that falls under its weight: 60 steps, after every 20 of which a far shorter one comes between where `between`
 * is not 0; it is saved before the next and goes on in another body. Displacements: *u [node_count], the caller's. */
static int step_between(sb_body_def *def, sb_real dt, sb_real between, sb_vec3 *u)
{
    sb_body *body = scene_body(def), *loaded = scene_body(def);
    size_t room = 0;
    void *state = NULL;
    sb_step_info info;
    sb_error error;
    int done = 0;
    scene_fix_plane(body, def->mesh, 0, 0, SB_XYZ);
    scene_fix_plane(loaded, def->mesh, 0, 0, SB_XYZ);
    for (int s = 0; s < 60; s++) {
        if (!CHECK_OK(sb_body_step(body, dt, &info)))
            break;
        done++;
        if (s % 20 != 10 || !(between > 0))
            continue;
        CHECK_OK(sb_body_step(body, between, &info));
        room = sb_body_state_size(body);
        state = realloc(state, room);
        CHECK_OK(sb_body_state_save(body, state, room));
        CHECK_OK(sb_body_state_load(loaded, state, room, &error));
    }
    for (int s = 51; s < 60 && between > 0; s++)
        CHECK_OK(sb_body_step(loaded, dt, &info));
    CHECK(!(between > 0) || sb_body_state_hash(loaded) == sb_body_state_hash(body));
    memcpy(u, sb_body_displacements(body), (size_t)def->mesh->node_count * sizeof *u);
    sb_body_destroy(body);
    sb_body_destroy(loaded);
    free(state);
    return done;
}

/* Steps that are far shorter than those around them change what follows by no more than the time they take: their
 * displacements are rounding, which must not become acceleration. */
static void test_far_shorter_steps(void)
{
    unsigned long long seed = 12;
    for (int k = 0; k < check_rounds(20); k++) {
        static const sb_integrator kinds[3] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA};
        sb_mesh mesh =
            scene_box(element_types[k % ELEMENT_TYPES], 4, 1, 2, sb_v3(REAL(0.1), REAL(0.02), REAL(0.02)), 0.1);
        sb_body_def def = sb_default_body_def();
        double least = SB_REAL_IS_FLOAT ? 5e-3 : 1e-10, dt = 0.005 + 0.02 * check_random(&seed);
        double share = 1e-2 * pow(least / 1e-2, check_random(&seed)), most = 0, size = 0;
        sb_vec3 *u[2];
        def.mesh = &mesh;
        def.material = k % 2 ? sb_material_corotated(REAL(2e4), REAL(0.4), 1000)
                             : sb_material_stable_neo_hookean(REAL(2e4), REAL(0.4), 1000);
        def.integrator = kinds[k / 2 % 3];
        def.spectral_radius = REAL(k % 5) / 4;
        def.max_newton = k % 4 ? 20 : 1;
        def.tolerance = def.newton_tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-9);
        def.gravity = sb_v3(0, 0, -5);
        def.damping_mass = REAL(0.5);
        def.damping_stiffness = k % 3 ? 0 : REAL(1e-3);
        for (int j = 0; j < 2; j++) {
            u[j] = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
            CHECK_INT(step_between(&def, REAL(dt), j ? REAL(share * dt) : 0, u[j]), 60);
        }
        for (int i = 0; i < mesh.node_count; i++) {
            most = fmax(most, (double)sb_v3_norm(sb_v3_sub(u[0][i], u[1][i])));
            size = fmax(size, (double)sb_v3_norm(u[0][i]));
        }
        if (!CHECK(most < (3 * share + (SB_REAL_IS_FLOAT ? 1e-2 : 1e-5)) * size))
            printf("    %s, radius %g, %g of a step between: off by %g of %g m\n", names[def.integrator],
                   (double)def.spectral_radius, share, most, size);
        free(u[0]);
        free(u[1]);
        sb_mesh_free(&mesh);
    }
}

static void test_undo(void)
{
    check_bad_numbers();
    sb_jobs jobs;
    memset(&jobs, 0, sizeof jobs);
    for (int k = SB_EULER; k <= SB_CENTRAL_DIFFERENCE; k++)
        for (int corotated = 0; corotated < 2; corotated++)
            CHECK(play_with_failure((sb_integrator)k, corotated, 5, jobs) ==
                  play_with_failure((sb_integrator)k, corotated, 0, jobs));
}

static void test_threads(void)
{
    sb_jobs inline_jobs;
    memset(&inline_jobs, 0, sizeof inline_jobs);
    for (int k = SB_GENERALISED_ALPHA; k <= SB_CENTRAL_DIFFERENCE; k++)
        for (int corotated = 0; corotated < 2; corotated++)
            for (int workers = 2; workers <= 7; workers += 5) {
                int count = workers;
                CHECK(play_with_failure((sb_integrator)k, corotated, 0, inline_jobs) ==
                      play_with_failure((sb_integrator)k, corotated, 0, scene_jobs(&count)));
            }
}

static void test_golden(void)
{
    static const unsigned long long expected[2][2] = {{0x2d21c848b5bd2f20ULL, 0xc9b2528497de5839ULL},
                                                      {0x7916f4926d45664cULL, 0xd357820da2a29e99ULL}};
    sb_jobs jobs;
    memset(&jobs, 0, sizeof jobs);
    if (SB_REAL_IS_FLOAT) {
        CHECK_SKIP("golden hashes are of double");
        return;
    }
    for (int k = 0; k < 2; k++)
        for (int corotated = 0; corotated < 2; corotated++) {
            unsigned long long hash =
                play_with_failure(k ? SB_CENTRAL_DIFFERENCE : SB_GENERALISED_ALPHA, corotated, 0, jobs);
            if (!CHECK(hash == expected[k][corotated]) || getenv("GOLDEN"))
                printf("  %s, %d: 0x%016llxULL\n", names[SB_GENERALISED_ALPHA + k], corotated, hash);
        }
}

/* ---- what is refused ---- */

static void refuse(sb_body_def def, sb_result expected)
{
    sb_body *body = NULL;
    sb_error error;
    CHECK_RESULT(sb_body_create(&def, &body, &error), expected);
    CHECK(body == NULL && error.result == expected && error.message[0]);
}

static void test_refusals(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 1, 1, 1, sb_v3(1, 1, 1), 0);
    sb_body_def def = sb_default_body_def(), bad;
    sb_body *body;
    sb_error error;
    sb_step_info info;
    sb_real dt = -7;
    def.mesh = &mesh;
    def.material = sb_material_neo_hookean(REAL(1e4), REAL(0.3), REAL(1000));
    check_bad_numbers();
    for (int k = 0; k < 3; k++) {
        bad = def;
        bad.spectral_radius = k == 0 ? REAL(-0.01) : k == 1 ? REAL(1.01) : REAL(NAN);
        refuse(bad, SB_ERROR_ARGUMENT);
    }
    bad = def;
    bad.max_substeps = 0;
    refuse(bad, SB_ERROR_ARGUMENT);
    def.integrator = SB_CENTRAL_DIFFERENCE;
    bad = def;
    bad.mass = SB_MASS_CONSISTENT;
    refuse(bad, SB_ERROR_UNSUPPORTED);
    bad.mass = SB_MASS_REDUCED;
    refuse(bad, SB_ERROR_UNSUPPORTED);
    bad = def;
    bad.damping_stiffness = REAL(0.01);
    refuse(bad, SB_ERROR_UNSUPPORTED);
    def.max_substeps = 5;
    body = scene_body(&def);
    CHECK_RESULT(sb_body_set_damping(body, 0, REAL(0.01)), SB_ERROR_UNSUPPORTED);
    CHECK_OK(sb_body_set_damping(body, 1, 0));
    CHECK_RESULT(sb_body_stable_step(NULL, &dt, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_stable_step(body, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK(dt == -7);
    CHECK_RESULT(sb_body_step(body, 1000, &info), SB_ERROR_NOT_CONVERGED);
    CHECK(strstr(info.error.message, "stable step") != NULL);
    CHECK_OK(sb_body_stable_step(body, &dt, &error));
    CHECK_OK(sb_body_step(body, 4 * dt, &info)); /* substeps of 0.9 stable ones */
    CHECK_INT(info.substeps, 5);
    { /* a shape that the material forbids */
        sb_vec3 u[8];
        memset(u, 0, sizeof u);
        u[7] = sb_v3(-3, -3, -3);
        CHECK_OK(sb_body_set_displacements(body, u));
        dt = -7;
        CHECK_RESULT(sb_body_stable_step(body, &dt, &error), SB_ERROR_INVERTED);
        CHECK(error.element >= 0 && dt == -7);
        CHECK_RESULT(sb_body_step(body, REAL(0.01), &info), SB_ERROR_INVERTED);
        CHECK(info.error.element >= 0);
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* A step allocates nothing, whatever the integrator. */
static void test_no_allocation(void)
{
    for (int k = SB_EULER; k <= SB_CENTRAL_DIFFERENCE; k++) {
        scene_memory memory = {0, 0, 0, 0};
        sb_mesh mesh = scene_box(SB_TET10, 2, 1, 1, sb_v3(REAL(0.2), REAL(0.1), REAL(0.1)), 0);
        sb_body_def def = sb_default_body_def();
        sb_real dt;
        sb_body *body;
        int calls;
        def.mesh = &mesh;
        def.material = sb_material_neo_hookean(REAL(1e4), REAL(0.3), REAL(1000));
        def.integrator = (sb_integrator)k;
        def.gravity = sb_v3(0, 0, -1);
        def.allocator = scene_allocator(&memory);
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        calls = memory.calls;
        for (int s = 0; s < 3; s++)
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        CHECK_OK(sb_body_stable_step(body, &dt, NULL));
        CHECK_INT(memory.calls, calls);
        sb_body_destroy(body);
        CHECK_INT(memory.live, 0);
        sb_mesh_free(&mesh);
    }
}

CHECK_SUITE(integrators, {"orders in time", test_orders}, {"far shorter steps", test_far_shorter_steps},
            {"spectral radius", test_spectral_radius}, {"generalised alpha gains no energy", test_alpha_never_gains},
            {"generalised alpha balances", test_alpha_balance}, {"generalised alpha follows", test_alpha_follows},
            {"generalised alpha is robust", test_alpha_is_robust},
            {"generalised alpha survives inversion", test_alpha_survives_inversion}, {"stable step", test_stable_step},
            {"explicit steps conserve", test_explicit_conserves}, {"explicit frames", test_explicit_frames},
            {"explicit violence", test_explicit_violence}, {"undo leaves no trace", test_undo},
            {"same bits for any threads", test_threads}, {"golden integrators", test_golden},
            {"refusals", test_refusals}, {"no allocation", test_no_allocation});
