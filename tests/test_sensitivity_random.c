/* test_sensitivity_random: derivatives of equilibria that nobody chose: against differences, the adjoint against the
 * direct way, the same bits for any number of threads, and a body that steps on as if nobody had asked. */
#include "random_case.h"

enum { ASKED = 7 };

typedef struct asked {
    random_case c;
    sb_body *body;
    sb_parameter parameters[ASKED];
    int loaded[3]; /* free nodes that FORCE and the loss name */
    int spring;
    sb_real stiffness; /* of it (N/m) */
} asked;

/* Free nodes of the mesh. */
static void asked_pick(asked *a, unsigned long long *seed)
{
    for (int k = 0; k < 3; k++) {
        int held = 1;
        for (int tries = 0; held && tries < 1000; tries++) {
            a->loaded[k] = random_below(seed, a->c.mesh.node_count);
            held = 0;
            for (int i = 0; i < a->c.held_count; i++)
                held = held || a->c.held[i] == a->loaded[k];
        }
    }
}

static void asked_name(asked *a, unsigned long long *seed)
{
    static const sb_parameter_kind kinds[ASKED] = {SB_PARAMETER_YOUNG,   SB_PARAMETER_POISSON, SB_PARAMETER_DENSITY,
                                                   SB_PARAMETER_GRAVITY, SB_PARAMETER_FORCE,   SB_PARAMETER_STIFFNESS,
                                                   SB_PARAMETER_SUPPORT};
    memset(a->parameters, 0, sizeof a->parameters);
    for (int k = 0; k < ASKED; k++) {
        sb_parameter *p = a->parameters + k;
        p->kind = kinds[k];
        p->axis = random_below(seed, 3);
        p->load_id = a->spring;
        p->nodes = p->kind == SB_PARAMETER_SUPPORT ? a->c.held : a->loaded;
        p->node_count = p->kind == SB_PARAMETER_SUPPORT ? a->c.held_count : 2;
    }
}

static int asked_solve(sb_body *body)
{
    sb_static_options options = sb_default_static_options();
    options.tolerance = SB_REAL_IS_FLOAT ? REAL(1e-5) : REAL(1e-12);
    options.forces_only = 1;
    return sb_body_solve_static(body, &options, NULL) == SB_OK;
}

static double asked_size(const asked *a)
{
    sb_vec3 low, high;
    sb_mesh_bounds(&a->c.mesh, &low, &high);
    return (double)sb_v3_norm(sb_v3_sub(high, low));
}

/* Gravity, a force and a spring. */
static int asked_load(asked *a, sb_body *body)
{
    double young = (double)sb_material_young(&a->c.material), size = asked_size(a);
    sb_vec3 force = sb_v3_scale(REAL(1e-5 * young * size * size), sb_v3(1, REAL(0.3), -1)), low, high;
    sb_mesh_bounds(&a->c.mesh, &low, &high);
    a->stiffness = REAL(1e-3 * young * size);
    CHECK_OK(sb_body_add_forces(body, a->loaded, 1, &force, 1));
    CHECK_OK(sb_body_add_springs(body, &a->loaded[2], 1, &a->stiffness, 1, &low, &a->spring, NULL));
    return asked_solve(body);
}

static int asked_make(asked *a, unsigned long long number, sb_jobs jobs)
{
    unsigned long long seed = number * 77 + 5;
    memset(a, 0, sizeof *a);
    if (!random_case_make(&a->c, number, 0))
        return 0;
    asked_pick(a, &seed);
    a->body = random_case_body(&a->c, jobs, 1e-12);
    if (!a->body || !asked_load(a, a->body)) {
        printf("%s: no equilibrium\n", a->c.name);
        sb_body_destroy(a->body);
        random_case_free(&a->c);
        return 0;
    }
    asked_name(a, &seed);
    return 1;
}

static void asked_free(asked *a)
{
    sb_body_destroy(a->body);
    random_case_free(&a->c);
}

static double asked_norm(const sb_vec3 *v, int n)
{
    double sum = 0;
    for (int i = 0; i < n; i++)
        sum += (double)sb_v3_dot(v[i], v[i]);
    return sqrt(sum);
}

/* The parameter changed by so much; of forces, changed again. */
static void asked_set(asked *a, const sb_parameter *p, double change)
{
    sb_material m = a->c.material;
    sb_real one = REAL(change);
    sb_vec3 along = sb_v3(p->axis == 0 ? one : 0, p->axis == 1 ? one : 0, p->axis == 2 ? one : 0);
    double young = (double)sb_material_young(&m), nu = (double)sb_material_poisson(&m);
    if (p->kind == SB_PARAMETER_YOUNG)
        young += change;
    if (p->kind == SB_PARAMETER_POISSON)
        nu += change;
    m.mu = REAL(young / (2 * (1 + nu)));
    m.lambda = REAL(young * nu / ((1 + nu) * (1 - 2 * nu)));
    m.c10 = m.mu / 2;
    m.d1 = REAL(6 * (1 - 2 * nu) / young);
    if (p->kind == SB_PARAMETER_DENSITY)
        m.density += one;
    CHECK_OK(sb_body_set_region_material(a->body, 0, &m, NULL));
    if (p->kind == SB_PARAMETER_GRAVITY)
        CHECK_OK(sb_body_set_gravity(a->body, sb_v3_add(a->c.gravity, along)));
    if (p->kind == SB_PARAMETER_STIFFNESS) {
        one += a->stiffness;
        CHECK_OK(sb_body_set_spring_stiffness(a->body, a->spring, &one, 1));
    }
    if (p->kind == SB_PARAMETER_FORCE)
        CHECK_OK(sb_body_add_forces(a->body, p->nodes, p->node_count, &along, 1));
    if (p->kind == SB_PARAMETER_SUPPORT)
        CHECK_OK(sb_body_prescribe(a->body, p->nodes, p->node_count, 1 << p->axis, &along, 1));
}

static double asked_stride(const asked *a, const sb_parameter *p)
{
    double young = (double)sb_material_young(&a->c.material), size = asked_size(a);
    switch (p->kind) {
    case SB_PARAMETER_YOUNG: return 1e-3 * young;
    case SB_PARAMETER_POISSON: return 1e-4;
    case SB_PARAMETER_DENSITY: return 1e-3 * (double)a->c.material.density;
    case SB_PARAMETER_GRAVITY: return 1e-3 * (double)sb_v3_norm(a->c.gravity);
    case SB_PARAMETER_FORCE: return 1e-6 * young * size * size;
    case SB_PARAMETER_STIFFNESS: return 1e-3 * (double)a->stiffness;
    default: return 1e-4 * size;
    }
}

static void asked_compare(asked *a, const sb_parameter *p, const sb_vec3 *du, const sb_vec3 *dr)
{
    int n = a->c.mesh.node_count;
    double h = asked_stride(a, p), off, size;
    sb_vec3 *u = (sb_vec3 *)malloc(2 * (size_t)n * sizeof *u), *r = u + n;
    asked_set(a, p, h);
    CHECK(asked_solve(a->body));
    for (int i = 0; i < n; i++)
        u[i] = sb_body_displacements(a->body)[i], r[i] = sb_body_reactions(a->body)[i];
    asked_set(a, p, p->kind == SB_PARAMETER_FORCE ? -2 * h : -h);
    CHECK(asked_solve(a->body));
    for (int i = 0; i < n; i++) {
        u[i] = sb_v3_sub(sb_v3_scale(REAL(0.5 / h), sb_v3_sub(u[i], sb_body_displacements(a->body)[i])), du[i]);
        r[i] = sb_v3_sub(sb_v3_scale(REAL(0.5 / h), sb_v3_sub(r[i], sb_body_reactions(a->body)[i])), dr[i]);
    }
    asked_set(a, p, p->kind == SB_PARAMETER_FORCE ? h : 0);
    if (p->kind == SB_PARAMETER_GRAVITY)
        CHECK_OK(sb_body_set_gravity(a->body, a->c.gravity));
    off = asked_norm(u, n), size = asked_norm(du, n);
    if (!CHECK(off <= 2e-4 * size))
        printf("  %s: kind %d: %g of %g\n", a->c.name, (int)p->kind, off, size);
    off = asked_norm(r, n), size = asked_norm(dr, n);
    if (!CHECK(off <=
               2e-4 * size + 1e-6 * asked_norm(sb_body_reactions(a->body), n) / h * (p->kind == SB_PARAMETER_SUPPORT)))
        printf("  %s: kind %d, reactions: %g of %g\n", a->c.name, (int)p->kind, off, size);
    free(u);
}

/* dJ/dp of a loss that looks at every node and reaction. */
static void asked_compare_adjoint(asked *a, const sb_vec3 *du, const sb_vec3 *dr)
{
    int n = a->c.mesh.node_count;
    unsigned long long seed = 3;
    sb_real gradient[ASKED];
    double stiff = (double)sb_material_young(&a->c.material) * asked_size(a);
    sb_vec3 *w = (sb_vec3 *)malloc(2 * (size_t)n * sizeof *w);
    for (int i = 0; i < 2 * n; i++)
        w[i] = sb_v3_scale(i < n ? 1 : REAL(1 / stiff), random_direction(&seed));
    CHECK_OK(sb_body_gradient(a->body, w, w + n, a->parameters, ASKED, gradient, NULL, NULL));
    for (int k = 0; k < ASKED; k++) {
        double sum = 0, size = 0;
        for (int i = 0; i < n; i++) {
            double x = (double)sb_v3_dot(w[i], du[k * n + i]), y = (double)sb_v3_dot(w[n + i], dr[k * n + i]);
            sum += x + y;
            size += fabs(x) + fabs(y);
        }
        if (!CHECK_NEAR((double)gradient[k], sum, size * scene_tolerance(1e-9, 1e5)))
            printf("  %s: kind %d\n", a->c.name, (int)a->parameters[k].kind);
    }
    free(w);
}

static void test_random(void)
{
    sb_jobs none;
    memset(&none, 0, sizeof none);
    for (int number = 0; number < check_rounds(10); number++) {
        asked a;
        int n;
        sb_vec3 *du;
        sb_error error;
        if (!asked_make(&a, (unsigned long long)number, none))
            continue;
        n = a.c.mesh.node_count;
        du = (sb_vec3 *)malloc(2 * ASKED * (size_t)n * sizeof *du);
        if (CHECK_OK(sb_body_sensitivities(a.body, a.parameters, ASKED, du, du + ASKED * n, &error))) {
            asked_compare_adjoint(&a, du, du + ASKED * n);
            for (int k = number % 2; !SB_REAL_IS_FLOAT && k < ASKED; k += 2)
                asked_compare(&a, a.parameters + k, du + k * n, du + (ASKED + k) * n);
        } else {
            printf("  %s: %s\n", a.c.name, error.message);
        }
        free(du);
        asked_free(&a);
    }
}

/* Derivatives and a tangent solve by 1, 2, 3 and 7 threads. */
static void test_threads(void)
{
    static const int counts[4] = {1, 2, 3, 7};
    for (int number = 40; number < (check_quick() ? 41 : 44); number++) {
        unsigned long long first[3] = {0, 0, 0};
        for (int t = 0; t < 4; t++) {
            int workers = counts[t], n;
            unsigned long long hash[3];
            sb_real gradient[ASKED];
            sb_vec3 *du;
            asked a;
            if (!asked_make(&a, (unsigned long long)number, scene_jobs(&workers)))
                continue;
            n = a.c.mesh.node_count;
            du = (sb_vec3 *)malloc(2 * ASKED * (size_t)n * sizeof *du);
            CHECK_OK(sb_body_sensitivities(a.body, a.parameters, ASKED, du, du + ASKED * n, NULL));
            hash[0] = scene_hash(du, 2 * ASKED * (size_t)n * sizeof *du);
            CHECK_OK(sb_body_gradient(a.body, du, du + ASKED * n, a.parameters, ASKED, gradient, du, NULL));
            hash[1] = scene_hash(gradient, sizeof gradient) ^ scene_hash(du, (size_t)n * sizeof *du);
            CHECK_OK(sb_body_solve_tangent(a.body, du, du, 2, REAL(1e-6), NULL));
            hash[2] = scene_hash(du, 2 * (size_t)n * sizeof *du);
            for (int k = 0; k < 3; k++) {
                if (t == 0)
                    first[k] = hash[k];
                CHECK(hash[k] == first[k]);
            }
            free(du);
            asked_free(&a);
        }
    }
}

/* Two bodies, one of which is asked before each step and solve: the same bits. */
static void test_untouched(void)
{
    sb_jobs none;
    memset(&none, 0, sizeof none);
    for (int number = 60; number < 60 + check_rounds(6); number++) {
        asked a, b;
        size_t bytes;
        sb_real gradient[ASKED];
        if (!asked_make(&a, (unsigned long long)number, none))
            continue;
        if (!asked_make(&b, (unsigned long long)number, none))
            continue;
        bytes = (size_t)a.c.mesh.node_count * sizeof(sb_vec3);
        for (int step = 0; step < 6; step++) {
            sb_result asked_result = sb_body_gradient(b.body, sb_body_displacements(b.body), NULL, b.parameters, ASKED,
                                                      gradient, NULL, NULL);
            CHECK(step > 0 || asked_result == SB_OK);
            if (step == 4) {
                CHECK(asked_solve(a.body) == asked_solve(b.body));
            } else {
                sb_result x = sb_body_step(a.body, a.c.dt, NULL), y = sb_body_step(b.body, a.c.dt, NULL);
                CHECK(x == y);
            }
            if (!CHECK(memcmp(sb_body_displacements(a.body), sb_body_displacements(b.body), bytes) == 0 &&
                       memcmp(sb_body_velocities(a.body), sb_body_velocities(b.body), bytes) == 0 &&
                       memcmp(sb_body_reactions(a.body), sb_body_reactions(b.body), bytes) == 0))
                printf("  %s, step %d\n", a.c.name, step);
        }
        asked_free(&a);
        asked_free(&b);
    }
}

/* ---- beyond what is factored ---- */

/* A bar of 10,980 nodes held at x = 0, without loads as yet: an equilibrium. A face of its end may be pressed. */
static sb_body *make_large(sb_mesh *mesh, sb_jobs jobs, int *pressure)
{
    sb_body_def def = sb_default_body_def();
    const int *last;
    int face[4];
    sb_body *body;
    *mesh = scene_box(SB_HEX8, 60, 11, 14, sb_v3(1, REAL(0.2), REAL(0.25)), 0.2);
    def.mesh = mesh;
    def.material = sb_material_corotated(REAL(5e4), REAL(0.3), 1000);
    def.jobs = jobs;
    body = scene_body(&def);
    scene_fix_plane(body, mesh, 0, 0, SB_XYZ);
    last = mesh->elements + 8 * (mesh->element_count - 1);
    face[0] = last[1], face[1] = last[2], face[2] = last[6], face[3] = last[5];
    CHECK_OK(sb_body_add_pressure(body, face, 1, 4, 0, pressure, NULL));
    return body;
}

/* Conjugate gradients in place of the factor: the adjoint agrees with the direct way and with the weight's closed form,
 * in the same bits for any number of threads. */
static void test_large(void)
{
    unsigned long long first = 0;
    for (int workers = 1; workers <= (check_quick() ? 1 : 3); workers += 2) {
        sb_mesh mesh;
        sb_parameter p[3];
        sb_real gradient[3];
        sb_error error;
        int pressure, node, n;
        sb_body *body = make_large(&mesh, scene_jobs(&workers), &pressure);
        sb_vec3 *du, *loss, *force;
        n = mesh.node_count, node = n - 1;
        CHECK(n > 10000);
        memset(p, 0, sizeof p);
        p[0].kind = SB_PARAMETER_GRAVITY;
        p[1].kind = SB_PARAMETER_PRESSURE, p[1].load_id = pressure;
        p[2].kind = SB_PARAMETER_FORCE, p[2].nodes = &node, p[2].node_count = 1;
        du = (sb_vec3 *)calloc(3 * (size_t)n, sizeof *du);
        loss = du + n, force = loss + n;
        loss[node].x = 1;
        if (!CHECK_OK(sb_body_gradient(body, loss, NULL, p, 3, gradient, force, &error)))
            printf("%s\n", error.message);
        CHECK_NEAR((double)gradient[0], 1000 / (2 * 5e4), 0.02 * 0.01); /* rho L^2 / 2 E, but at the held end */
        CHECK_NEAR((double)gradient[2], (double)force[node].x, 1e-12 * (double)gradient[2]);
        for (int k = 1; k < (workers == 1 ? 2 : 0); k++) {
            CHECK_OK(sb_body_sensitivities(body, p + k, 1, du, NULL, NULL));
            CHECK_NEAR((double)gradient[k], (double)du[node].x, scene_tolerance(1e-8, 1e5) * fabs((double)gradient[k]));
        }
        first = workers == 1 ? scene_hash(force, (size_t)n * sizeof *force) : first;
        CHECK(scene_hash(force, (size_t)n * sizeof *force) == first);
        free(du);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* ---- bodies that are no plain meshes ---- */

static sb_real ball_distance(void *user, sb_vec3 point)
{
    (void)user;
    return sb_v3_norm(sb_v3_sub(point, sb_v3(REAL(0.013), REAL(-0.007), 0))) - REAL(0.5);
}

/* A ball in a grid, cells cut by its surface. */
static void make_ball(sb_grid *grid)
{
    sb_grid_def def = sb_default_grid_def();
    sb_error error;
    memset(grid, 0, sizeof *grid);
    memset(&def.outer, 0, sizeof def.outer);
    def.outer.distance = ball_distance;
    def.outer.max_slope = 1;
    def.low = sb_v3(REAL(-0.6), REAL(-0.6), REAL(-0.6)), def.high = sb_v3(REAL(0.6), REAL(0.6), REAL(0.6));
    def.counts[0] = def.counts[1] = def.counts[2] = 5;
    if (!CHECK_OK(sb_grid_create(&def, grid, &error)))
        printf("%s\n", error.message);
}

/* sum of all displacements along z under young (Pa), nu and g. */
static double solve_sum(sb_body *body, double young, double poisson, double g)
{
    sb_material m = sb_material_neo_hookean(REAL(young), REAL(poisson), 1000);
    CHECK_OK(sb_body_set_region_material(body, 0, &m, NULL));
    CHECK_OK(sb_body_set_gravity(body, sb_v3(0, REAL(0.1), REAL(g))));
    CHECK(asked_solve(body));
    return (double)scene_sum(sb_body_displacements(body), sb_body_node_count(body)).z;
}

/* By Young's modulus, Poisson's ratio and gravity against differences, and density by its weight. */
static void compare_sum(sb_body *body, const double *gradient)
{
    double young = (solve_sum(body, 5005, 0.35, -0.5) - solve_sum(body, 4995, 0.35, -0.5)) / 10;
    double poisson = (solve_sum(body, 5000, 0.3501, -0.5) - solve_sum(body, 5000, 0.3499, -0.5)) / 2e-4;
    double g = (solve_sum(body, 5000, 0.35, -0.4995) - solve_sum(body, 5000, 0.35, -0.5005)) / 1e-3;
    const double bound = SB_REAL_IS_FLOAT ? 0.1 : 1e-5;
    CHECK_NEAR(gradient[0], young, bound * fabs(young));
    CHECK_NEAR(gradient[1], poisson, bound * fabs(poisson));
    CHECK_NEAR(gradient[2], g, bound * fabs(g));
}

static void ask_sum(sb_body *body, int with_elements)
{
    int n = sb_body_node_count(body), first = with_elements ? 0 : 2;
    sb_parameter p[4];
    sb_real gradient[4] = {0, 0, 0, 0};
    double found[3];
    sb_error error;
    sb_vec3 *up = (sb_vec3 *)malloc((size_t)n * sizeof *up);
    for (int i = 0; i < n; i++)
        up[i] = sb_v3(0, 0, 1);
    memset(p, 0, sizeof p);
    p[0].kind = SB_PARAMETER_YOUNG, p[1].kind = SB_PARAMETER_POISSON, p[2].kind = SB_PARAMETER_GRAVITY, p[2].axis = 2;
    p[3] = p[2], p[3].axis = 1;
    solve_sum(body, 5000, 0.35, -0.5);
    if (!CHECK_OK(sb_body_gradient(body, up, NULL, p + first, 4 - first, gradient + first, NULL, &error)))
        printf("%s\n", error.message);
    for (int k = 0; k < 3; k++)
        found[k] = (double)gradient[k];
    if (with_elements) {
        sb_real by_density;
        p[0].kind = SB_PARAMETER_DENSITY; /* all weight is density times gravity */
        CHECK_OK(sb_body_gradient(body, up, NULL, p, 1, &by_density, NULL, NULL));
        CHECK_NEAR((double)by_density * 1000, -0.5 * found[2] + 0.1 * (double)gradient[3],
                   scene_tolerance(1e-8, 1e4) * fabs(found[2]));
        compare_sum(body, found);
    } else {
        double g = (solve_sum(body, 5000, 0.35, -0.4995) - solve_sum(body, 5000, 0.35, -0.5005)) / 1e-3;
        CHECK_NEAR(found[2], g, (SB_REAL_IS_FLOAT ? 0.1 : 1e-5) * fabs(g));
    }
    free(up);
}

static void test_grid(void)
{
    sb_grid grid;
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    make_ball(&grid);
    def.mesh = &grid.body_mesh;
    def.domain = &grid.domain;
    def.material = sb_material_neo_hookean(5000, REAL(0.35), 1000);
    body = scene_body(&def);
    scene_fix_plane(body, &grid.body_mesh, 2, -0.6, SB_XYZ);
    ask_sum(body, 1);
    sb_body_destroy(body);
    sb_grid_free(&grid);
}

/* A node of no element has no displacement and no share; a mesh with cells taken out of it has loads. */
static void test_lone_and_changed(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 5, 3, 3, sb_v3(1, REAL(0.5), REAL(0.5)), 0.1), more = mesh;
    int lone = mesh.node_count;
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    sb_vec3 *ones = (sb_vec3 *)malloc(((size_t)lone + 1) * sizeof *ones);
    more.nodes = (sb_vec3 *)malloc(((size_t)lone + 1) * sizeof *more.nodes);
    memcpy(more.nodes, mesh.nodes, (size_t)lone * sizeof *more.nodes);
    more.nodes[lone] = sb_v3(3, 3, 3);
    more.node_count++;
    def.mesh = &more;
    def.material = sb_material_neo_hookean(5000, REAL(0.35), 1000);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    ask_sum(body, 1);
    for (int i = 0; i <= lone; i++)
        ones[i] = sb_v3(1, 1, 1);
    CHECK_OK(sb_body_solve_tangent(body, ones, ones, 1, REAL(1e-6), NULL));
    CHECK(sb_v3_norm(ones[lone]) == 0 && sb_v3_norm(ones[lone - 1]) > 0);
    sb_body_destroy(body);
    body = scene_changing_body(&mesh, def.material);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    scene_remove_cells(body);
    ask_sum(body, 0);
    sb_body_destroy(body);
    free(ones);
    free(more.nodes);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(sensitivity_random, {"random", test_random}, {"threads", test_threads}, {"untouched", test_untouched},
            {"large", test_large}, {"grid", test_grid}, {"lone and changed", test_lone_and_changed});
