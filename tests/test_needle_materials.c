/* needle_materials: needles in bodies of every material, iterated and linearised: friction balance, energy, convergence
 * with mesh and steps, solvers, and what is refused. */
#include "needle_scene.h"

static const double dt = 0.02, speed = 0.01;

/* ---- every material ---- */

typedef struct variant {
    const char *name;
    sb_material material;
    int max_newton, has_fibres;
} variant;

enum { VARIANTS = 12 };

static void list_variants(variant *v)
{
    static const sb_real g[2] = {REAL(0.3), REAL(0.2)}, tau[2] = {REAL(0.05), REAL(0.5)};
    const sb_real E = 50000, nu = REAL(0.4), rho = 1000;
    int n = 0;
    memset(v, 0, VARIANTS * sizeof *v);
    v[n].name = "linear", v[n++].material = sb_material_linear(E, nu, rho);
    v[n].name = "corotated", v[n++].material = sb_material_corotated(E, nu, rho);
    v[n].name = "corotated invertible", v[n++].material = sb_material_corotated_invertible(E, nu, rho);
    v[n].name = "neo-Hookean", v[n++].material = sb_material_neo_hookean(E, nu, rho);
    v[n].name = "stable neo-Hookean", v[n++].material = sb_material_stable_neo_hookean(E, nu, rho);
    v[n].name = "neo-Hookean, isochoric", v[n++].material = sb_material_neo_hookean_isochoric(9000, REAL(2.5e-5), rho);
    v[n].name = "Mooney-Rivlin", v[n++].material = sb_material_mooney_rivlin(6000, 3000, REAL(2.5e-5), rho);
    v[n].name = "Prony terms", v[n++].material = sb_material_with_prony(sb_material_neo_hookean(E, nu, rho), g, tau, 2);
    v[n].name = "fibres", v[n].has_fibres = 1;
    v[n++].material = sb_material_with_fibres(sb_material_stable_neo_hookean(E, nu, rho), 20000, 2);
    for (int i = 0; i < n; i++)
        v[i].max_newton = 1;
    v[n] = v[1], v[n].name = "corotated, iterated", v[n++].max_newton = 20;
    v[n] = v[3], v[n].name = "neo-Hookean, iterated", v[n++].max_newton = 20;
    v[n] = v[7], v[n].name = "Prony terms, iterated", v[n++].max_newton = 20;
    CHECK_INT(n, VARIANTS);
}

static double whole_energy(const needle_scene *s)
{
    sb_energy body = {0, 0, 0};
    ndl_rod_energy rod = ndl_rod_energies(ndl_needle_rod(s->needles[0]));
    CHECK_OK(sb_body_energy(s->body, &body));
    return (double)body.elastic + (double)body.kinetic + (double)rod.stretch + (double)rod.bend + (double)rod.twist +
           (double)rod.kinetic;
}

/* In by 2.5 cm, still, and out: friction by the depth, no energy from nowhere, and the mesh as it was. */
static void through(const variant *v)
{
    needle_scene s = needle_scene_default();
    static sb_vec3 fibres[6000]; /* large for a stack */
    s.other = &v->material;
    s.body_def.max_newton = v->max_newton;
    for (int e = 0; e < 6000; e++)
        fibres[e] = sb_v3(1, REAL(0.3), 0);
    s.body_def.fibres = v->has_fibres ? fibres : NULL;
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 125, needle_command(speed, 0))) {
        double depth = (double)ndl_needle_depth(s.needles[0]), energy, most;
        needle_scene_run(&s, dt, 1, needle_command(speed, 0));
        CHECK(depth > 0.02);
        CHECK_NEAR(needle_push(&s), 20 * depth + 0.5, 0.02 * (20 * depth + 0.5));
        needle_scene_run(&s, dt, 2, needle_command(0, 0));
        energy = most = whole_energy(&s);
        for (int i = 0; i < 40; i++) {
            double now;
            needle_scene_run(&s, dt, 1, needle_command(0, 0));
            now = whole_energy(&s);
            CHECK(now < energy + 0.01 * most);
            energy = now;
        }
        needle_scene_run(&s, dt, 40, needle_command(-speed, 0));
        depth = (double)ndl_needle_depth(s.needles[0]);
        needle_scene_run(&s, dt, 1, needle_command(-speed, 0));
        CHECK_NEAR(needle_push(&s), -20 * depth, 0.02 * 20 * depth + 0.005);
        CHECK(needle_scene_is_sound(&s));
        needle_scene_run(&s, dt, 120, needle_command(-speed, 0));
        CHECK(needle_scene_is_original(&s));
    }
    needle_scene_free(&s);
}

static void test_materials(void)
{
    variant v[VARIANTS];
    list_variants(v);
    for (int i = 0; i < VARIANTS; i += check_quick() ? 3 : 1) {
        int failures = check.failures;
        through(v + i);
        if (check.failures > failures)
            printf("%s\n", v[i].name);
    }
}

/* ---- convergence ---- */

/* The push while the needle goes sideways by 1 mm, 2 cm deep: what the tissue answers with, which mesh and steps
 * change. */
static double sideways(int cells, double step, int max_newton)
{
    needle_scene s = needle_scene_default();
    sb_vec3 force = sb_v3(0, 0, 0);
    s.cells[0] = s.cells[1] = s.cells[2] = cells;
    s.shake = 0;
    s.body_def.max_newton = max_newton;
    s.body_def.tolerance = REAL(scene_tolerance(1e-6, 100));
    if (needle_scene_make(&s) && needle_scene_run(&s, step, (int)(2.1 / step + 0.5), needle_command(speed, 0))) {
        ndl_command aside = needle_command(0, 0);
        aside.velocity.x = REAL(0.002);
        needle_scene_run(&s, step, (int)(0.5 / step + 0.5), aside);
        needle_scene_run(&s, step, (int)(0.5 / step + 0.5), needle_command(0, 0));
        ndl_needle_base_wrench(s.needles[0], &force, NULL);
    }
    needle_scene_free(&s);
    return (double)force.x;
}

static void test_convergence(void)
{
    double coarse = sideways(4, 0.02, 1), fine = sideways(4, 0.01, 1), finest = sideways(4, 0.005, 1);
    double iterated = sideways(4, 0.02, 20), dense = sideways(6, 0.02, 1);
    CHECK(finest > 0.05);
    CHECK(fabs(coarse - finest) < 0.03 * finest);
    CHECK(fabs(fine - finest) < 0.02 * finest);
    CHECK(fabs(iterated - coarse) < 0.02 * finest);
    CHECK(fabs(dense - coarse) < 0.35 * finest); /* a line of nodes holds the softer the finer the mesh is */
}

/* ---- increments cut short ---- */

/* A node in five that is not near the needle flies at random, by up to an element in a step: elements would turn inside
 * out, and every increment of Newton's method is cut short. */
static void throw_nodes(const needle_scene *s, unsigned long long *random)
{
    int count = sb_body_node_count(s->body);
    const sb_vec3 *x = sb_body_positions(s->body);
    sb_vec3 *v = (sb_vec3 *)malloc((size_t)count * sizeof *v);
    double most = 0.01 / dt;
    if (!CHECK(v != NULL))
        return;
    memcpy(v, sb_body_velocities(s->body), (size_t)count * sizeof *v);
    for (int i = 0; i < count; i++) {
        sb_real aside = sb_v3_norm(sb_v3(x[i].x - s->needle_def.base.x, x[i].y - s->needle_def.base.y, 0));
        if (!needle_scene_is_side(s, x[i]) && aside > REAL(0.007) && check_random(random) < 0.2)
            v[i] = sb_v3(REAL(check_random_in(random, -most, most)), REAL(check_random_in(random, -most, most)),
                         REAL(check_random_in(random, -most, most)));
    }
    CHECK_OK(sb_body_set_velocities(s->body, v));
    free(v);
}

/* Whatever becomes of the tissue, the sleeve pushes with no more than friction and tip can hold: forces of a step that
 * did not get to its end are none. Returns how many steps were capped. */
static int among_thrown_nodes(int seed, ndl_follow follow)
{
    needle_scene s = needle_scene_default();
    sb_material material;
    unsigned long long random = (unsigned long long)seed;
    int capped = 0;
    material = sb_material_neo_hookean(REAL(check_random_in(&random, 4000, 40000)), REAL(0.45), 1000);
    s.other = &material;
    s.body_def.integrator = seed % 2 ? SB_EULER : SB_GENERALISED_ALPHA;
    s.body_def.max_newton = 2 + seed % 5;
    s.needle_def.follow = follow;
    if (needle_scene_make(&s))
        for (int i = 0; i < 20; i++) {
            ndl_command command = needle_command((i < 5 ? 5 : 1) * speed * check_random_in(&random, 0.5, 1.5), 0);
            sb_result result;
            if (i > 5 && i % 3 == 0)
                throw_nodes(&s, &random);
            result = ndl_step(s.body, s.needles, 1, REAL(dt), &command, &s.info, &s.error);
            if (result == SB_OK && !CHECK(needle_push(&s) < 20 * (double)ndl_needle_depth(s.needles[0]) + 0.6))
                printf("seed %d step %d: %g N of %g\n", seed, i, needle_push(&s),
                       20 * (double)ndl_needle_depth(s.needles[0]) + 0.5);
            if (!CHECK_OK(result))
                printf("seed %d step %d: %s\n", seed, i, s.error.message);
            capped += s.info.body.capped || s.info.substeps > 1;
        }
    needle_scene_free(&s);
    return capped;
}

static void test_cut_increments(void)
{
    int capped = 0;
    for (int seed = 1; seed <= (check_quick() ? 2 : 5); seed++)
        capped += among_thrown_nodes(seed, seed % 4 < 2 ? NDL_EMBED : NDL_REMESH);
    printf("%d steps capped or divided\n", capped);
    CHECK(capped > 3);
}

/* ---- scenes at random ---- */

/* What friction and tip can hold, and what bends the needle, whose share along it they do not limit. */
static double most_push(const needle_scene *s, double friction, double cutting)
{
    sb_vec3 sum = needle_contact_sum(s->needles[0]);
    double aside = (double)sb_v3_norm(sb_v3_sub(sum, sb_v3(0, 0, sum.z)));
    double depth = (double)ndl_needle_depth(s->needles[0]) + (double)s->size.x / s->cells[0];
    return 1.05 * (friction * depth + cutting) + 0.05 + 0.5 * aside;
}

static double spread(unsigned long long *random, double low, double high)
{
    return exp(check_random_in(random, log(low), log(high)));
}

static sb_material random_material(unsigned long long *random)
{
    double young = spread(random, 1000, 100000), poisson = check_random_in(random, 0.3, 0.49);
    sb_real mu = REAL(young / 2 / (1 + poisson)), d1 = REAL(6 * (1 - 2 * poisson) / young), alpha = 4;
    switch ((int)check_random_in(random, 0, 6)) {
    case 0: return sb_material_neo_hookean(REAL(young), REAL(poisson), 1000);
    case 1: return sb_material_stable_neo_hookean(REAL(young), REAL(poisson), 1000);
    case 2: return sb_material_mooney_rivlin(REAL(0.3) * mu, REAL(0.2) * mu, d1, 1000);
    case 3: return sb_material_neo_hookean_isochoric(REAL(0.5) * mu, d1, 1000);
    case 4: return sb_material_corotated(REAL(young), REAL(poisson), 1000);
    default: return sb_material_ogden(&mu, &alpha, 1, d1, 1000);
    }
}

/* Nodes are thrown by up to 1.3 edges in a step. */
static void throw_far(const needle_scene *s, double step, unsigned long long *random)
{
    int count = sb_body_node_count(s->body);
    double edge = (double)s->size.x / s->cells[0], most = check_random_in(random, 0.3, 1.3) * edge / step;
    double share = check_random_in(random, 0.05, 0.3);
    const sb_vec3 *x = sb_body_positions(s->body);
    sb_vec3 *v = (sb_vec3 *)malloc((size_t)count * sizeof *v);
    if (!CHECK(v != NULL))
        return;
    memcpy(v, sb_body_velocities(s->body), (size_t)count * sizeof *v);
    for (int i = 0; i < count; i++) {
        sb_vec3 aside = sb_v3(x[i].x - s->needle_def.base.x, x[i].y - s->needle_def.base.y, 0);
        if (!needle_scene_is_side(s, x[i]) && (double)sb_v3_norm(aside) > 0.7 * edge && check_random(random) < share)
            v[i] = sb_v3(REAL(check_random_in(random, -most, most)), REAL(check_random_in(random, -most, most)),
                         REAL(check_random_in(random, -most, most)));
    }
    CHECK_OK(sb_body_set_velocities(s->body, v));
    free(v);
}

/* A needle that has torn out springs back: its force is that of its own mass. */
static int is_held(const ndl_needle *needle)
{
    int entry = ndl_needle_entry(needle);
    return entry < ndl_rod_node_count(ndl_needle_rod(needle)) && ndl_needle_contact(needle, entry) != NDL_FREE;
}

typedef struct random_run {
    int steps, refused, pushed_too_hard;
} random_run;

/* A needle goes in within 12 steps, then tissue is thrown about in 24. */
static void run_at_random(unsigned long long random, random_run *run)
{
    static const sb_integrator integrators[3] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA};
    needle_scene s = needle_scene_default();
    sb_material material = random_material(&random);
    double step = spread(&random, 1e-3, 0.05), friction = spread(&random, 2, 60), cutting = spread(&random, 0.1, 1.5);
    s.other = &material;
    s.cells[0] = s.cells[1] = 3 + (int)check_random_in(&random, 0, 4);
    s.cells[2] = 3 + (int)check_random_in(&random, 0, 4);
    s.shake = check_random_in(&random, 0, 0.3);
    s.body_def.integrator = integrators[(int)check_random_in(&random, 0, 3)];
    s.body_def.max_newton = 1 + (int)check_random_in(&random, 0, 8);
    s.needle_def.follow = check_random(&random) < 0.6 ? NDL_EMBED : NDL_REMESH;
    s.needle_def.base.x += REAL(check_random_in(&random, -0.004, 0.004));
    s.frictions[0].friction = REAL(friction);
    s.frictions[0].cutting = REAL(cutting);
    if (needle_scene_make(&s))
        for (int i = 0; i < 36; i++) {
            ndl_command command = needle_command((i < 12 ? 1 : check_random_in(&random, -0.2, 0.3)) * 0.001 / step, 0);
            sb_result result;
            if (i >= 12 && i % 3 == 0)
                throw_far(&s, step, &random);
            result = ndl_step(s.body, s.needles, 1, REAL(step), &command, &s.info, &s.error);
            run->steps++;
            run->refused += result != SB_OK;
            if (result == SB_OK && i > 0 && is_held(s.needles[0]) && !s.info.blocked &&
                !(fabs(needle_push(&s)) < most_push(&s, friction, cutting))) {
                run->pushed_too_hard++;
                printf("step %d: %g N of %g\n", i, needle_push(&s), most_push(&s, friction, cutting));
            }
        }
    needle_scene_free(&s);
}

/* Forces of a step that was found are those of friction, and nearly all steps are found. */
static void test_random_scenes(void)
{
    random_run run = {0, 0, 0};
    int most = getenv("CHECK_SLOW") ? 200 : check_rounds(20);
    for (int k = 0; k < (check_quick() ? 2 : most); k++)
        run_at_random(2654435761ULL * (unsigned long long)(k + 1), &run);
    printf("%d steps, %d refused\n", run.steps, run.refused);
    CHECK_INT(run.pushed_too_hard, 0);
    CHECK(run.refused <= 0.05 * run.steps);
}

/* ---- steps that fail for good ---- */

static sb_real count_substeps(void *user, sb_vec3 X, int region)
{
    (void)X, (void)region;
    ++*(int *)user;
    return REAL(0.5);
}

/* A supported node is drawn through the block, whose material does not allow what is inside out: however short its
 * substeps, a part of the step fails. Returns how many were tried. */
static int draw_through(ndl_follow follow, double way)
{
    needle_scene s = needle_scene_default();
    sb_material material = sb_material_neo_hookean(5000, REAL(0.45), 1000);
    unsigned long long bits;
    int tried = 0;
    s.other = &material;
    s.body_def.max_newton = 4;
    s.needle_def.follow = follow;
    s.needle_def.cutting = count_substeps;
    s.needle_def.cutting_user = &tried;
    if (needle_scene_make(&s) && needle_scene_run(&s, dt, 30, needle_command(speed, 0))) {
        ndl_command command = needle_command(speed, 0);
        int node = 0;
        sb_vec3 to;
        while (node < s.mesh.node_count &&
               !(needle_scene_is_side(&s, s.mesh.nodes[node]) && s.mesh.nodes[node].x == 0 &&
                 s.mesh.nodes[node].y > REAL(0.015) && s.mesh.nodes[node].z > REAL(0.015)))
            node++;
        to = sb_v3_add(s.mesh.nodes[node], sb_v3(REAL(way), 0, 0));
        CHECK_OK(sb_body_place(s.body, &node, 1, SB_XYZ, &to, NULL));
        tried = 0;
        bits = needle_scene_bits(&s);
        CHECK(ndl_step(s.body, s.needles, 1, REAL(dt), &command, &s.info, &s.error) != SB_OK);
        CHECK(needle_scene_bits(&s) == bits);
        printf("%d substeps tried: %s\n", tried, s.error.message);
    }
    needle_scene_free(&s);
    return tried;
}

static void test_for_good(void)
{
    for (int k = 0; k < 4; k++) {
        int tried = draw_through(k % 2 ? NDL_EMBED : NDL_REMESH, k < 2 ? 0.05 : 0.3);
        CHECK(tried > 0 && tried <= 40);
    }
}

/* ---- solvers ---- */

/* All find the same. */
static void test_preconditioners(void)
{
    enum { KINDS = 6 };
    static const sb_precond_kind kinds[KINDS] = {SB_PRECOND_IC0,  SB_PRECOND_MULTIGRID, SB_PRECOND_BLOCK_JACOBI,
                                                 SB_PRECOND_SSOR, SB_PRECOND_FSAI,      SB_PRECOND_CHOLESKY};
    double push[KINDS] = {0, 0, 0, 0, 0, 0};
    for (int k = 0; k < KINDS; k++) {
        needle_scene s = needle_scene_default();
        s.body_def.preconditioner = kinds[k];
        s.body_def.tolerance = REAL(scene_tolerance(1e-7, 1000));
        s.body_def.max_iterations = 5000;
        if (needle_scene_make(&s) && needle_scene_run(&s, dt, 100, needle_command(speed, 1))) {
            push[k] = needle_push(&s);
            CHECK_INT(s.info.capped, 0);
            CHECK(needle_scene_is_sound(&s));
        }
        needle_scene_free(&s);
    }
    CHECK(push[0] > 0.5);
    for (int k = 1; k < KINDS; k++)
        CHECK_NEAR(push[k], push[0], scene_tolerance(1e-3, 10) * push[0]);
}

/* ---- refusals ---- */

static void refuse(sb_element_type type, sb_real slack, const char *names)
{
    sb_body_def def = needle_scene_body_def();
    ndl_needle_def needle = ndl_default_needle_def();
    ndl_needle *made = NULL;
    sb_body *body = NULL;
    sb_mesh mesh;
    sb_error error;
    if (!CHECK_OK(sb_mesh_beam(type, 2, 2, 2, sb_v3(REAL(0.04), REAL(0.04), REAL(0.04)), NULL, &mesh, &error)))
        return;
    def.mesh = &mesh;
    def.material = sb_material_corotated(50000, REAL(0.4), 1000);
    def.slack = slack;
    if (CHECK_OK(sb_body_create(&def, &body, &error))) {
        needle.body = body;
        needle.follow = NDL_REMESH;
        needle.base = sb_v3(REAL(0.02), REAL(0.02), REAL(0.1));
        needle.direction = sb_v3(0, 0, -1);
        CHECK_RESULT(ndl_needle_create(&needle, &made, &error), SB_ERROR_UNSUPPORTED);
        CHECK(made == NULL && strstr(error.message, names) != NULL);
        CHECK_OK(sb_body_step(body, REAL(dt), NULL));
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_refusals(void)
{
    refuse(SB_TET4, 0, "slack");
    refuse(SB_HEX8, REAL(0.2), "SB_TET4");
    refuse(SB_TET10, REAL(0.2), "SB_TET4");
}

/* An explicit body has no system to be solved with. */
static void test_explicit(void)
{
    needle_scene s = needle_scene_default();
    s.body_def.integrator = SB_CENTRAL_DIFFERENCE;
    s.body_def.damping_stiffness = 0;
    if (needle_scene_make_body(&s)) {
        ndl_needle_def def = s.needle_def;
        ndl_needle *needle = NULL;
        def.body = s.body;
        CHECK_RESULT(ndl_needle_create(&def, &needle, &s.error), SB_ERROR_UNSUPPORTED);
        CHECK(needle == NULL && strstr(s.error.message, "explicit") != NULL);
    }
    needle_scene_free(&s);
}

/* Others may change the mesh while no needle is in it, and not while one is. */
static void test_changes_by_others(void)
{
    needle_scene s = needle_scene_default();
    if (needle_scene_make(&s)) {
        for (int in = 0; in < 2; in++) {
            sb_body_change *change = NULL;
            int node = 62, cells = sb_body_element_count(s.body);
            sb_vec3 X = sb_body_rest_positions(s.body)[node];
            sb_result result;
            X.x += REAL(1e-4);
            CHECK_OK(sb_body_change_begin(s.body, &change, &s.error));
            CHECK_OK(sb_body_change_move_node(change, node, X, NULL, NULL, 0, &s.error));
            result = sb_body_change_commit(change, &s.error);
            CHECK_RESULT(result, in ? SB_ERROR_STATE : SB_OK);
            if (result != SB_OK)
                sb_body_change_cancel(change);
            needle_scene_run(&s, dt, 60, needle_command(speed, 0));
            CHECK(needle_scene_is_sound(&s));
            CHECK(cells <= sb_body_element_count(s.body));
        }
        needle_scene_run(&s, dt, 180, needle_command(-speed, 0));
        CHECK(ndl_remesh_is_original(ndl_needle_remesh(s.needles[0])));
    }
    needle_scene_free(&s);
}

CHECK_SUITE(needle_materials, {"every material", test_materials}, {"meshes and steps", test_convergence},
            {"cut increments", test_cut_increments}, {"random scenes", test_random_scenes}, {"for good", test_for_good},
            {"every solver", test_preconditioners}, {"refusals", test_refusals}, {"explicit bodies", test_explicit},
            {"changes by others", test_changes_by_others});
