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
    for (int number = 40; number < (check_quick() ? 42 : 46); number++) {
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
    for (int number = 60; number < 60 + check_rounds(10); number++) {
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

CHECK_SUITE(sensitivity_random, {"random", test_random}, {"threads", test_threads}, {"untouched", test_untouched});
