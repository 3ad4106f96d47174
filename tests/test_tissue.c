/* tissue: steps against sb_body's, balances, and a matrix that keeps up with needles that come and go. */
#include "scene.h"

#include "needle.h"

static const ndl_tissue_material gel = {REAL(5e4), REAL(0.45), 1000};

static ndl_tissue_def tissue_def(const sb_mesh *mesh)
{
    ndl_tissue_def def = ndl_default_tissue_def();
    def.mesh = mesh;
    def.materials = &gel;
    def.material_count = 1;
    def.lazy_angle = 0;
    def.tolerance = REAL(scene_tolerance(1e-12, 100));
    def.max_iterations = 2000;
    return def;
}

static ndl_tissue *make_tissue(const ndl_tissue_def *def)
{
    ndl_tissue *tissue = NULL;
    sb_error error;
    if (ndl_tissue_create(def, &tissue, &error) != SB_OK) {
        printf("%s\n", error.message);
        CHECK(tissue != NULL);
    }
    return tissue;
}

static void fix_end(ndl_tissue *tissue, const sb_mesh *mesh)
{
    for (int i = 0; i < mesh->node_count; i++)
        if (mesh->nodes[i].x < REAL(1e-6))
            CHECK_OK(ndl_tissue_fix(tissue, i));
}

static sb_mesh small_beam(void) { return scene_box(SB_TET4, 8, 3, 3, sb_v3(REAL(0.2), REAL(0.06), REAL(0.06)), 0.1); }

/* ---- against sb_body ---- */

/* Steps of both with a node that is led along and a force; largest distance of positions, velocities, reactions. */
static void compare_with_body(sb_integrator integrator, ndl_integrator same)
{
    sb_mesh mesh = small_beam();
    sb_body_def body_def = sb_default_body_def();
    ndl_tissue_def def = tissue_def(&mesh);
    int tip = mesh.node_count - 1, led = mesh.node_count / 2;
    double far = 0, fast = 0, strong = 0;
    sb_body *body;
    ndl_tissue *tissue;
    body_def.mesh = &mesh;
    body_def.material = sb_material_corotated(gel.young, gel.poisson, gel.density);
    body_def.integrator = integrator;
    body_def.max_newton = 1;
    body_def.tolerance = def.tolerance;
    body_def.max_iterations = def.max_iterations;
    body_def.gravity = def.gravity = sb_v3(0, REAL(1), REAL(-9.81));
    body_def.damping_stiffness = def.damping_stiffness = REAL(0.004);
    body_def.damping_mass = def.damping_mass = REAL(0.7);
    def.integrator = same;
    body = scene_body(&body_def);
    tissue = make_tissue(&def);
    if (body && tissue) {
        fix_end(tissue, &mesh);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        CHECK_OK(ndl_tissue_set_gravity(tissue, def.gravity));
        for (int s = 0; s < 40; s++) {
            sb_vec3 way = sb_v3(0, REAL(0.0004 * s), REAL(0.0002 * s));
            CHECK_OK(sb_body_prescribe(body, &led, 1, SB_XYZ, &way, 1));
            CHECK_OK(ndl_tissue_prescribe(tissue, led, sb_v3_add(mesh.nodes[led], way), NULL));
            if (s == 30) {
                CHECK_OK(sb_body_release_nodes(body, &led, 1, SB_XYZ));
                CHECK_OK(ndl_tissue_release(tissue, led));
            }
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
            CHECK_OK(ndl_tissue_step(tissue, REAL(0.01), NULL, NULL));
            far = fmax(far, scene_distance(sb_body_positions(body), ndl_tissue_positions(tissue), mesh.node_count));
            fast = fmax(fast, scene_distance(sb_body_velocities(body), ndl_tissue_velocities(tissue), mesh.node_count));
            strong =
                fmax(strong, scene_distance(sb_body_reactions(body), ndl_tissue_reactions(tissue), mesh.node_count));
        }
        CHECK(far > 0 && far < scene_tolerance(1e-10, 2000) * 0.2);
        CHECK(fast < scene_tolerance(1e-9, 20000));
        CHECK(strong < scene_tolerance(1e-8, 20000));
        CHECK(sb_v3_norm(sb_v3_sub(ndl_tissue_positions(tissue)[tip], mesh.nodes[tip])) > REAL(0.01));
        {
            ndl_tissue_energies energies = ndl_tissue_get_energies(tissue);
            sb_energy energy;
            CHECK_OK(sb_body_energy(body, &energy));
            CHECK_NEAR(energies.elastic, energy.elastic, scene_tolerance(1e-9, 1e4) * (double)energy.elastic);
            CHECK_NEAR(energies.kinetic, energy.kinetic, scene_tolerance(1e-9, 1e4) * (double)energy.kinetic);
        }
    }
    sb_body_destroy(body);
    ndl_tissue_destroy(tissue);
    sb_mesh_free(&mesh);
}

static void test_body_newmark(void) { compare_with_body(SB_NEWMARK, NDL_NEWMARK); }
static void test_body_euler(void) { compare_with_body(SB_EULER, NDL_EULER); }

static void test_static_rest(void)
{
    sb_mesh mesh = small_beam();
    sb_body_def body_def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    ndl_tissue_def def = tissue_def(&mesh);
    ndl_tissue *tissue;
    sb_body *body;
    body_def.mesh = &mesh;
    body_def.material = sb_material_corotated(gel.young, gel.poisson, gel.density);
    body_def.gravity = def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.integrator = NDL_EULER;
    def.damping_stiffness = REAL(0.05);
    body = scene_body(&body_def);
    tissue = make_tissue(&def);
    if (body && tissue) {
        double span;
        fix_end(tissue, &mesh);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        options.tolerance = REAL(scene_tolerance(1e-10, 100));
        CHECK_OK(sb_body_solve_static(body, &options, NULL));
        for (int s = 0; s < 300; s++)
            CHECK_OK(ndl_tissue_step(tissue, REAL(0.1), NULL, NULL));
        span = scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count);
        CHECK(span > 0.01);
        CHECK(scene_distance(sb_body_positions(body), ndl_tissue_positions(tissue), mesh.node_count) <
              scene_tolerance(1e-7, 2e4) * span);
    }
    sb_body_destroy(body);
    ndl_tissue_destroy(tissue);
    sb_mesh_free(&mesh);
}

/* ---- balances ---- */

/* Momentum's rate is gravity, loads and reactions; Euler's is taken at the end of the step. */
static void test_balance(void)
{
    sb_mesh mesh = small_beam();
    ndl_tissue_def def = tissue_def(&mesh);
    ndl_tissue *tissue;
    sb_vec3 push = sb_v3(REAL(0.1), REAL(-0.3), REAL(0.2));
    def.integrator = NDL_EULER;
    def.gravity = sb_v3(REAL(0.5), 0, REAL(-9.81));
    tissue = make_tissue(&def);
    if (tissue) {
        sb_real mass = ndl_tissue_mesh_mass(ndl_tissue_get_mesh(tissue)), dt = REAL(0.01);
        fix_end(tissue, &mesh);
        CHECK_OK(ndl_tissue_set_force(tissue, mesh.node_count - 1, push));
        for (int s = 0; s < 20; s++) {
            sb_vec3 before = ndl_tissue_momentum(tissue), sum = sb_v3_madd(push, mass, def.gravity), rate;
            CHECK_OK(ndl_tissue_step(tissue, dt, NULL, NULL));
            rate = sb_v3_scale(1 / dt, sb_v3_sub(ndl_tissue_momentum(tissue), before));
            for (int i = 0; i < mesh.node_count; i++)
                sum = sb_v3_add(sum, ndl_tissue_reactions(tissue)[i]);
            CHECK(sb_v3_norm(sb_v3_sub(rate, sum)) < REAL(scene_tolerance(1e-8, 1e4)) * mass * 10);
        }
    }
    ndl_tissue_destroy(tissue);
    sb_mesh_free(&mesh);
}

static void spin(ndl_tissue *tissue, sb_vec3 rate, sb_vec3 speed)
{
    ndl_tissue_mesh *mesh = ndl_tissue_get_mesh(tissue);
    for (int i = 0; i < mesh->node_end; i++)
        mesh->v[i] = sb_v3_add(speed, sb_v3_cross(rate, mesh->x[i]));
}

static void test_free_body(void)
{
    for (int newmark = 0; newmark < 2; newmark++) {
        sb_mesh mesh = small_beam();
        ndl_tissue_def def = tissue_def(&mesh);
        ndl_tissue *tissue;
        def.integrator = newmark ? NDL_NEWMARK : NDL_EULER;
        tissue = make_tissue(&def);
        if (tissue) {
            sb_vec3 first;
            spin(tissue, sb_v3(0, REAL(2), REAL(1)), sb_v3(REAL(0.3), REAL(0.1), REAL(-0.2)));
            first = ndl_tissue_momentum(tissue);
            for (int s = 0; s < 50; s++)
                CHECK_OK(ndl_tissue_step(tissue, REAL(0.01), NULL, NULL));
            CHECK(sb_v3_norm(sb_v3_sub(ndl_tissue_momentum(tissue), first)) <
                  REAL(scene_tolerance(1e-10, 2000)) * sb_v3_norm(first));
            CHECK(ndl_tissue_get_energies(tissue).kinetic > REAL(1e-3));
        }
        ndl_tissue_destroy(tissue);
        sb_mesh_free(&mesh);
    }
}

/* A prescribed node is where it was told, as fast as it was told, and rests afterwards. */
static void test_prescribed(void)
{
    sb_mesh mesh = small_beam();
    ndl_tissue_def def = tissue_def(&mesh);
    ndl_tissue *tissue = make_tissue(&def);
    if (tissue) {
        int node = mesh.node_count - 1;
        sb_vec3 to = sb_v3_add(mesh.nodes[node], sb_v3(REAL(0.003), 0, REAL(0.001)));
        sb_vec3 velocity = sb_v3(REAL(0.1), REAL(0.2), 0), zero = sb_v3(0, 0, 0);
        fix_end(tissue, &mesh);
        CHECK_OK(ndl_tissue_prescribe(tissue, node, to, &velocity));
        CHECK_INT(ndl_tissue_is_held(tissue, node), 1);
        CHECK_OK(ndl_tissue_step(tissue, REAL(0.02), NULL, NULL));
        CHECK(memcmp(ndl_tissue_positions(tissue) + node, &to, sizeof to) == 0);
        CHECK(memcmp(ndl_tissue_velocities(tissue) + node, &velocity, sizeof to) == 0);
        CHECK_OK(ndl_tissue_step(tissue, REAL(0.02), NULL, NULL));
        CHECK(memcmp(ndl_tissue_positions(tissue) + node, &to, sizeof to) == 0);
        CHECK(memcmp(ndl_tissue_velocities(tissue) + node, &zero, sizeof to) == 0);
        CHECK(sb_v3_norm(ndl_tissue_reactions(tissue)[node]) > REAL(1e-3));
        CHECK_OK(ndl_tissue_release(tissue, node));
        CHECK_INT(ndl_tissue_is_held(tissue, node), 0);
        CHECK_OK(ndl_tissue_step(tissue, REAL(0.02), NULL, NULL));
        CHECK(memcmp(ndl_tissue_positions(tissue) + node, &to, sizeof to) != 0);
        CHECK(sb_v3_norm(ndl_tissue_reactions(tissue)[node]) == 0);
        CHECK_INT(ndl_tissue_get_mesh(tissue)->node_flags[0] & NDL_NODE_FIXED, NDL_NODE_FIXED);
    }
    ndl_tissue_destroy(tissue);
    sb_mesh_free(&mesh);
}

/* ---- the matrix ---- */

/* K from nothing but mesh and positions, by the formula of R K0 R^T, tet by tet, against the tissue's: largest
 * difference over the largest entry. x: positions K was made at. */
static double matrix_error(const ndl_tissue *tissue, const ndl_tissue_mesh *mesh, const sb_vec3 *x,
                           ndl_tissue_material material)
{
    size_t n = (size_t)mesh->node_end;
    sb_real lambda = material.young * material.poisson / ((1 + material.poisson) * (1 - 2 * material.poisson));
    sb_real mu = material.young / (2 * (1 + material.poisson)), largest = 0, worst = 0;
    sb_mat3 *row = (sb_mat3 *)malloc(n * sizeof(sb_mat3));
    for (int i = 0; i < mesh->node_end; i++) {
        memset(row, 0, n * sizeof(sb_mat3));
        for (int k = mesh->node_flags[i] ? mesh->node_star[i] : -1; k >= 0; k = mesh->corner_next[k]) {
            const int *t = mesh->tets + 4 * (k / 4);
            sb_vec3 g[4], h[4];
            sb_mat3 shape, now, inverse, r;
            shape = sb_m3_columns(sb_v3_sub(mesh->X[t[1]], mesh->X[t[0]]), sb_v3_sub(mesh->X[t[2]], mesh->X[t[0]]),
                                  sb_v3_sub(mesh->X[t[3]], mesh->X[t[0]]));
            now = sb_m3_columns(sb_v3_sub(x[t[1]], x[t[0]]), sb_v3_sub(x[t[2]], x[t[0]]), sb_v3_sub(x[t[3]], x[t[0]]));
            inverse = sb_m3_inverse(shape);
            r = sb_quat_to_mat3(sb_m3_polar_cold(sb_m3_mul(now, inverse)));
            for (int a = 1; a < 4; a++)
                g[a] = sb_v3(inverse.m[a - 1][0], inverse.m[a - 1][1], inverse.m[a - 1][2]);
            g[0] = sb_v3_scale(-1, sb_v3_add(g[1], sb_v3_add(g[2], g[3])));
            for (int a = 0; a < 4; a++)
                h[a] = sb_m3_apply(r, g[a]);
            for (int b = 0; b < 4; b++) {
                sb_mat3 block = sb_m3_add(sb_m3_scale(lambda, sb_m3_outer(h[k % 4], h[b])),
                                          sb_m3_scale(mu, sb_m3_outer(h[b], h[k % 4])));
                for (int c = 0; c < 3; c++)
                    block.m[c][c] += mu * sb_v3_dot(h[k % 4], h[b]);
                row[t[b]] = sb_m3_add(row[t[b]], sb_m3_scale(mesh->volumes[k / 4], block));
            }
        }
        for (int j = 0; j < mesh->node_end; j++) {
            sb_mat3 k = ndl_tissue_stiffness(tissue, i, j);
            for (int c = 0; c < 9; c++) {
                sb_real gap = sb_abs(k.m[c / 3][c % 3] - row[j].m[c / 3][c % 3]);
                largest = sb_max(largest, sb_abs(row[j].m[c / 3][c % 3]));
                worst = gap <= worst ? worst : gap;
            }
        }
    }
    free(row);
    return (double)(worst / largest);
}

/* ---- needles that come and go ---- */

typedef struct visits {
    sb_mesh mesh;
    ndl_tissue *tissue;
    ndl_tissue_mesh *at;
    ndl_remesh *remesh;
    double edge;
    unsigned long long seed;
    sb_vec3 *x; /* before the last step */
    int operations, most_nodes;
    double worst_matrix;
    sb_vec3 momentum; /* what it should be */
    double drift;
} visits;

static int visits_begin(visits *w, ndl_tissue_def *def, sb_mesh mesh, double edge)
{
    ndl_remesh_def remesh = ndl_default_remesh_def();
    memset(w, 0, sizeof *w);
    w->mesh = mesh;
    w->edge = edge;
    w->seed = 3;
    w->tissue = make_tissue(def);
    w->x = (sb_vec3 *)malloc(4 * (size_t)mesh.node_count * sizeof(sb_vec3));
    if (!w->tissue)
        return 0;
    w->at = ndl_tissue_get_mesh(w->tissue);
    remesh.tissue = w->at;
    return CHECK_OK(ndl_remesh_create(&remesh, &w->remesh, NULL));
}

static void visits_end(visits *w)
{
    ndl_remesh_destroy(w->remesh);
    ndl_tissue_destroy(w->tissue);
    free(w->x);
    sb_mesh_free(&w->mesh);
}

static void visits_step(visits *w)
{
    sb_error error;
    memcpy(w->x, w->at->x, (size_t)w->at->node_end * sizeof(sb_vec3));
    if (!CHECK_OK(ndl_tissue_step(w->tissue, REAL(0.01), NULL, &error)))
        printf("%s\n", error.message);
    w->most_nodes = w->at->node_count > w->most_nodes ? w->at->node_count : w->most_nodes;
    w->drift = fmax(w->drift, (double)sb_v3_norm(sb_v3_sub(ndl_tissue_momentum(w->tissue), w->momentum)));
}

static sb_vec3 visits_entry(visits *w)
{
    sb_vec3 low, high;
    sb_mesh_bounds(&w->mesh, &low, &high);
    return sb_v3(low.x + (high.x - low.x) * REAL(check_random_in(&w->seed, 0.3, 0.7)),
                 low.y + (high.y - low.y) * REAL(check_random_in(&w->seed, 0.3, 0.7)), high.z);
}

/* In along a slanted line and out again, a time step after each operation. */
static void visit(visits *w)
{
    sb_vec3 entry = visits_entry(w), step, X;
    int count = 4 + (int)check_random_in(&w->seed, 0, 10), depth = 0;
    ndl_surface_hit hit;
    ndl_remesh_info info;
    double x = check_random_in(&w->seed, -0.3, 0.3), y = check_random_in(&w->seed, -0.3, 0.3);
    step = sb_v3_scale(REAL(0.14 * w->edge), sb_v3(REAL(x), REAL(y), -1));
    /* the tissue may have moved: the needle enters where it was aimed in the material, seen from where that is now */
    for (int t = 0; t < w->at->tet_end; t++)
        for (int f = 0; w->at->tets[4 * t] >= 0 && f < 4; f++) {
            const int *n = w->at->tets + 4 * t;
            sb_real weights[4];
            int outward = w->at->neighbours[4 * t + f] < 0 && w->at->X[n[(f + 1) % 4]].z > entry.z - REAL(1e-6) &&
                          w->at->X[n[(f + 2) % 4]].z > entry.z - REAL(1e-6) &&
                          w->at->X[n[(f + 3) % 4]].z > entry.z - REAL(1e-6);
            if (!outward || ndl_tissue_mesh_find(w->at, w->at->X, sb_v3(entry.x, entry.y, entry.z), t, weights) != t)
                continue;
            hit.tet = t, hit.face = f, hit.along = 0, hit.X = entry;
            if (ndl_remesh_puncture(w->remesh, 0, &hit, &info, NULL) != SB_OK)
                continue;
            depth = 1;
            t = w->at->tet_end;
            break;
        }
    if (!CHECK(depth == 1))
        return;
    visits_step(w);
    X = info.X;
    while (depth < count && ndl_remesh_penetrate(w->remesh, 0, sb_v3_add(X, step), &info, NULL) == SB_OK &&
           !info.outside) {
        X = info.X;
        depth++;
        w->operations += info.substeps;
        visits_step(w);
    }
    for (; depth > 2; depth--) {
        X = sb_v3_sub(X, step);
        if (ndl_remesh_retract(w->remesh, 0, X, &info, NULL) != SB_OK)
            break;
        w->operations += info.substeps;
        visits_step(w);
    }
    CHECK_OK(ndl_remesh_withdraw(w->remesh, 0, &info, NULL));
    CHECK(ndl_tissue_mesh_is_original(w->at));
}

static void test_visits(void)
{
    int count = check_quick() ? 8 : 200;
    visits w;
    sb_mesh mesh = scene_box(SB_TET4, 4, 4, 4, sb_v3(REAL(0.04), REAL(0.04), REAL(0.04)), 0.15);
    ndl_tissue_def def = tissue_def(&mesh);
    double mass, speed;
    def.tolerance = REAL(scene_tolerance(1e-9, 100));
    if (visits_begin(&w, &def, mesh, 0.01)) {
        double *first = (double *)malloc((size_t)mesh.node_count * sizeof(double));
        for (int i = 0; i < mesh.node_count; i++)
            first[i] = (double)w.at->mass[i];
        mass = (double)ndl_tissue_mesh_mass(w.at);
        spin(w.tissue, sb_v3(REAL(0.3), REAL(-0.2), REAL(0.5)), sb_v3(REAL(0.01), 0, REAL(0.02)));
        w.momentum = ndl_tissue_momentum(w.tissue);
        speed = (double)sb_v3_norm(w.momentum);
        for (int i = 0; i < count; i++) {
            visit(&w);
            visits_step(&w);
            w.worst_matrix = fmax(w.worst_matrix, matrix_error(w.tissue, w.at, w.x, gel));
            CHECK(fabs((double)ndl_tissue_mesh_mass(w.at) - mass) <= scene_tolerance(1e-12, 100) * mass);
        }
        CHECK(w.worst_matrix < scene_tolerance(1e-11, 500));
        CHECK(w.drift < scene_tolerance(1e-8, 2e4) * speed);
        CHECK(w.operations > 3 * count);
        CHECK(w.most_nodes > mesh.node_count);
        for (int i = 0; i < mesh.node_count; i++) {
            CHECK(fabs((double)w.at->mass[i] - first[i]) <= 16 * (double)SB_EPSILON * first[i]);
            CHECK(sb_v3_is_finite(w.at->x[i]) && sb_v3_is_finite(w.at->v[i]));
        }
        free(first);
    }
    visits_end(&w);
}

/* While the needle is in, the matrix is that of the changed mesh; the same steps as a tissue made afresh of it. */
static void test_split_mesh(void)
{
    visits w;
    sb_mesh mesh = scene_box(SB_TET4, 5, 5, 4, sb_v3(REAL(0.05), REAL(0.05), REAL(0.04)), 0.15);
    ndl_tissue_def def = tissue_def(&mesh);
    ndl_surface_hit hit;
    ndl_remesh_info info;
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.slack = 0; /* all must grow */
    def.integrator = NDL_EULER;
    if (visits_begin(&w, &def, mesh, 0.01)) {
        for (int i = 0; i < mesh.node_count; i++)
            if (mesh.nodes[i].z < REAL(1e-6))
                CHECK_OK(ndl_tissue_fix(w.tissue, i));
        CHECK(ndl_tissue_mesh_hit(w.at, sb_v3(REAL(0.023), REAL(0.027), REAL(0.05)),
                                  sb_v3(REAL(0.023), REAL(0.027), 0), &hit));
        CHECK_OK(ndl_remesh_puncture(w.remesh, 0, &hit, &info, NULL));
        for (int s = 1; s < 14; s++) {
            CHECK_OK(ndl_remesh_penetrate(w.remesh, 0, sb_v3_add(hit.X, sb_v3(0, REAL(0.0003 * s), REAL(-0.0015 * s))),
                                          &info, NULL));
            memcpy(w.x, w.at->x, (size_t)w.at->node_end * sizeof(sb_vec3));
            CHECK_OK(ndl_tissue_step(w.tissue, REAL(0.01), NULL, NULL));
            CHECK(matrix_error(w.tissue, w.at, w.x, gel) < scene_tolerance(1e-11, 500));
        }
        CHECK(w.at->node_count > mesh.node_count);
        CHECK_OK(ndl_remesh_withdraw(w.remesh, 0, &info, NULL));
        for (int s = 0; s < 100; s++) /* back to the rest it would have had without */
            CHECK_OK(ndl_tissue_step(w.tissue, REAL(0.05), NULL, NULL));
        {
            ndl_tissue *other = make_tissue(&def);
            for (int i = 0; other && i < mesh.node_count; i++)
                if (mesh.nodes[i].z < REAL(1e-6))
                    CHECK_OK(ndl_tissue_fix(other, i));
            for (int s = 0; other && s < 100; s++)
                CHECK_OK(ndl_tissue_step(other, REAL(0.05), NULL, NULL));
            CHECK(other && scene_distance(ndl_tissue_positions(other), w.at->x, mesh.node_count) <
                               scene_tolerance(1e-9, 1e3) * 0.01);
            ndl_tissue_destroy(other);
        }
    }
    visits_end(&w);
}

/* ---- laziness, solver, threads ---- */

static void test_lazy(void)
{
    sb_mesh mesh = small_beam();
    sb_vec3 *exact = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof(sb_vec3));
    int refreshed[2] = {0, 0};
    for (int lazy = 0; lazy < 2; lazy++) {
        ndl_tissue_def def = tissue_def(&mesh);
        ndl_tissue_info info;
        ndl_tissue *tissue;
        def.lazy_angle = lazy ? REAL(0.01) : 0;
        def.gravity = sb_v3(0, 0, -1);
        tissue = make_tissue(&def);
        if (!tissue)
            continue;
        fix_end(tissue, &mesh);
        for (int s = 0; s < 60; s++) {
            CHECK_OK(ndl_tissue_step(tissue, REAL(0.01), &info, NULL));
            refreshed[lazy] += info.refreshed;
        }
        if (!lazy)
            memcpy(exact, ndl_tissue_positions(tissue), (size_t)mesh.node_count * sizeof(sb_vec3));
        else
            CHECK(scene_distance(exact, ndl_tissue_positions(tissue), mesh.node_count) <
                  0.01 * scene_distance(exact, mesh.nodes, mesh.node_count));
        ndl_tissue_destroy(tissue);
    }
    CHECK_INT(refreshed[0], 60 * mesh.element_count);
    CHECK(refreshed[1] < refreshed[0] / 3);
    free(exact);
    sb_mesh_free(&mesh);
}

/* With the coarse space iterations do not grow with the mesh. */
static void test_iterations(void)
{
    for (int fine = 0; fine < 2; fine++) {
        sb_mesh mesh = scene_box(SB_TET4, fine ? 40 : 20, fine ? 8 : 4, fine ? 8 : 4,
                                 sb_v3(REAL(0.2), REAL(0.04), REAL(0.04)), 0);
        ndl_tissue_def def = tissue_def(&mesh);
        ndl_tissue_info info;
        ndl_tissue *tissue;
        def.tolerance = REAL(1e-3);
        def.gravity = sb_v3(0, 0, REAL(-1));
        tissue = make_tissue(&def);
        if (tissue) {
            fix_end(tissue, &mesh);
            for (int s = 0; s < 12; s++) {
                CHECK_OK(ndl_tissue_step(tissue, REAL(0.02), &info, NULL));
                CHECK(info.iterations > 0 && info.iterations <= 45);
                CHECK(info.residual <= REAL(1e-3) && !info.capped);
            }
        }
        ndl_tissue_destroy(tissue);
        sb_mesh_free(&mesh);
    }
}

static void test_capped(void)
{
    sb_mesh mesh = small_beam();
    ndl_tissue_def def = tissue_def(&mesh);
    ndl_tissue_info info;
    ndl_tissue *tissue;
    def.max_iterations = 2;
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    tissue = make_tissue(&def);
    if (tissue) {
        fix_end(tissue, &mesh);
        CHECK_OK(ndl_tissue_step(tissue, REAL(0.01), &info, NULL));
        CHECK_INT(info.capped, 1);
        CHECK_INT(info.iterations, 2);
        CHECK_OK(ndl_tissue_set_gravity(tissue, sb_v3(0, 0, 0)));
    }
    ndl_tissue_destroy(tissue);
    tissue = make_tissue(&def);
    if (tissue) { /* nothing to do */
        CHECK_OK(ndl_tissue_set_gravity(tissue, sb_v3(0, 0, 0)));
        CHECK_OK(ndl_tissue_step(tissue, REAL(0.01), &info, NULL));
        CHECK_INT(info.iterations, 0);
        CHECK(memcmp(ndl_tissue_positions(tissue), mesh.nodes, (size_t)mesh.node_count * sizeof(sb_vec3)) == 0);
    }
    ndl_tissue_destroy(tissue);
    sb_mesh_free(&mesh);
}

static unsigned long long play(sb_jobs jobs)
{
    visits w;
    sb_mesh mesh = scene_box(SB_TET4, 6, 6, 6, sb_v3(REAL(0.06), REAL(0.06), REAL(0.06)), 0.15);
    ndl_tissue_def def = ndl_default_tissue_def();
    unsigned long long hash = 0;
    def.mesh = &mesh;
    def.materials = &gel;
    def.material_count = 1;
    def.jobs = jobs;
    if (visits_begin(&w, &def, mesh, 0.01)) {
        size_t bytes = (size_t)mesh.node_count * sizeof(sb_vec3);
        spin(w.tissue, sb_v3(REAL(1), REAL(-2), REAL(3)), sb_v3(0, 0, 0));
        for (int i = 0; i < 3; i++)
            visit(&w);
        hash = scene_hash(w.at->x, bytes) ^ scene_hash(w.at->v, bytes) ^ scene_hash(w.at->a, bytes);
    }
    visits_end(&w);
    return hash;
}

static void test_threads(void)
{
    sb_jobs none;
    unsigned long long alone;
    memset(&none, 0, sizeof none);
    alone = play(none);
    for (int workers = 2; workers <= 5; workers += 3)
        CHECK(play(scene_jobs(&workers)) == alone);
}

/* A material that is set is that of the next step; regions have their own. */
static void test_materials(void)
{
    sb_mesh mesh = small_beam();
    ndl_tissue_material two[2], hard = gel;
    ndl_tissue_def def = tissue_def(&mesh);
    ndl_tissue *tissue;
    sb_error error;
    int *regions = (int *)calloc((size_t)mesh.element_count, sizeof(int));
    two[0] = two[1] = gel;
    two[1].density = 2000;
    regions[0] = 1;
    mesh.regions = regions;
    def.materials = two;
    def.material_count = 2;
    tissue = make_tissue(&def);
    if (tissue) {
        ndl_tissue_mesh *at = ndl_tissue_get_mesh(tissue);
        CHECK_NEAR(ndl_tissue_mesh_mass(at), 1000 * (0.2 * 0.06 * 0.06 + (double)at->volumes[0]),
                   scene_tolerance(1e-12, 1000));
        hard.young *= 3;
        hard.poisson = REAL(0.3);
        CHECK_OK(ndl_tissue_set_material(tissue, 0, hard.young, hard.poisson, &error));
        CHECK_OK(ndl_tissue_set_material(tissue, 1, hard.young, hard.poisson, &error));
        CHECK_OK(ndl_tissue_step(tissue, REAL(0.01), NULL, NULL));
        CHECK(matrix_error(tissue, at, mesh.nodes, hard) < scene_tolerance(1e-12, 100));
        CHECK_RESULT(ndl_tissue_set_material(tissue, 2, 1, 0, &error), SB_ERROR_INDEX);
        CHECK_RESULT(ndl_tissue_set_material(tissue, 0, 0, 0, &error), SB_ERROR_MATERIAL);
        CHECK_RESULT(ndl_tissue_set_material(tissue, 0, 1, REAL(0.5), &error), SB_ERROR_MATERIAL);
        CHECK_RESULT(ndl_tissue_set_material(NULL, 0, 1, 0, &error), SB_ERROR_ARGUMENT);
    }
    ndl_tissue_destroy(tissue);
    mesh.regions = NULL;
    free(regions);
    sb_mesh_free(&mesh);
}

/* Thrown about and inside out: it comes to rest in its shape again. */
static void calm_down(ndl_integrator integrator)
{
    sb_mesh mesh = small_beam();
    ndl_tissue_def def = tissue_def(&mesh);
    unsigned long long seed = 9;
    ndl_tissue *tissue;
    def.integrator = integrator;
    def.tolerance = REAL(1e-3);
    def.damping_stiffness = REAL(0.02);
    tissue = make_tissue(&def);
    if (tissue) {
        ndl_tissue_mesh *at = ndl_tissue_get_mesh(tissue);
        int steps = integrator == NDL_EULER ? 600 : 1500;
        double first, last, kinetic;
        ndl_tissue_energies energies;
        fix_end(tissue, &mesh);
        for (int i = 0; i < mesh.node_count; i++)
            if (!ndl_tissue_is_held(tissue, i)) {
                at->x[i] = sb_v3(REAL(check_random_in(&seed, -0.1, 0.3)), REAL(check_random_in(&seed, -0.1, 0.1)),
                                 REAL(check_random_in(&seed, -0.1, 0.1)));
                at->v[i] = sb_v3(REAL(check_random_in(&seed, -10, 10)), 0, 0);
            }
        energies = ndl_tissue_get_energies(tissue);
        first = (double)energies.elastic + (double)energies.kinetic;
        for (int s = 0; s < steps; s++)
            CHECK_OK(ndl_tissue_step(tissue, REAL(0.02), NULL, NULL));
        energies = ndl_tissue_get_energies(tissue);
        last = (double)energies.elastic + (double)energies.kinetic;
        kinetic = (double)energies.kinetic;
        CHECK(last < first && kinetic < 1e-9 * first);
    }
    ndl_tissue_destroy(tissue);
    sb_mesh_free(&mesh);
}

static void test_violence(void)
{
    calm_down(NDL_EULER);
    calm_down(NDL_NEWMARK);
}

/* ---- failures ---- */

static void test_refusals(void)
{
    sb_mesh mesh = small_beam();
    ndl_tissue_material bad = gel;
    ndl_tissue_def def;
    sb_error error;
    ndl_tissue *tissue = NULL;
    int outside = mesh.node_count;
#define REFUSE(change, expected)                                                                                       \
    do {                                                                                                               \
        def = tissue_def(&mesh);                                                                                       \
        change;                                                                                                        \
        CHECK_RESULT(ndl_tissue_create(&def, &tissue, &error), expected);                                              \
        CHECK(tissue == NULL && error.message[0] != 0);                                                                \
    } while (0)
    REFUSE(def.cookie = 0, SB_ERROR_ARGUMENT);
    REFUSE(def.mesh = NULL, SB_ERROR_ARGUMENT);
    REFUSE(def.materials = NULL, SB_ERROR_ARGUMENT);
    REFUSE(def.material_count = 0, SB_ERROR_ARGUMENT);
    REFUSE(def.fixed_count = 1, SB_ERROR_ARGUMENT);
    REFUSE((def.fixed_count = 1, def.fixed_nodes = &outside), SB_ERROR_INDEX);
    REFUSE(def.integrator = (ndl_integrator)3, SB_ERROR_ARGUMENT);
    REFUSE(def.damping_mass = -1, SB_ERROR_ARGUMENT);
    check_bad_numbers();
    REFUSE(def.damping_stiffness = REAL(NAN), SB_ERROR_ARGUMENT);
    REFUSE(def.gravity.y = REAL(INFINITY), SB_ERROR_NOT_FINITE);
    REFUSE(def.slack = -1, SB_ERROR_ARGUMENT);
    REFUSE(def.lazy_angle = 2, SB_ERROR_ARGUMENT);
    REFUSE(def.tolerance = 0, SB_ERROR_ARGUMENT);
    REFUSE(def.max_iterations = 0, SB_ERROR_ARGUMENT);
    REFUSE((bad.young = 0, def.materials = &bad), SB_ERROR_MATERIAL);
    REFUSE((bad = gel, bad.poisson = REAL(0.5), def.materials = &bad), SB_ERROR_MATERIAL);
    REFUSE((bad = gel, bad.density = -1, def.materials = &bad), SB_ERROR_MATERIAL);
#undef REFUSE
    def = tissue_def(&mesh);
    CHECK_RESULT(ndl_tissue_create(NULL, &tissue, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(ndl_tissue_create(&def, NULL, &error), SB_ERROR_ARGUMENT);
    ndl_tissue_destroy(NULL);
    tissue = make_tissue(&def);
    if (tissue) {
        sb_vec3 nowhere = sb_v3(REAL(NAN), 0, 0), zero = sb_v3(0, 0, 0);
        CHECK_RESULT(ndl_tissue_step(tissue, 0, NULL, &error), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_tissue_step(tissue, REAL(NAN), NULL, &error), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_tissue_step(NULL, 1, NULL, &error), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_tissue_fix(tissue, -1), SB_ERROR_INDEX);
        CHECK_RESULT(ndl_tissue_fix(tissue, outside), SB_ERROR_INDEX);
        CHECK_RESULT(ndl_tissue_fix(NULL, 0), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_tissue_release(tissue, outside), SB_ERROR_INDEX);
        CHECK_RESULT(ndl_tissue_prescribe(tissue, outside, zero, NULL), SB_ERROR_INDEX);
        CHECK_RESULT(ndl_tissue_prescribe(tissue, 0, nowhere, NULL), SB_ERROR_NOT_FINITE);
        CHECK_RESULT(ndl_tissue_prescribe(tissue, 0, zero, &nowhere), SB_ERROR_NOT_FINITE);
        CHECK_INT(ndl_tissue_is_held(tissue, 0), 0);
        CHECK_INT(ndl_tissue_is_held(tissue, outside), 0);
        CHECK_RESULT(ndl_tissue_set_force(tissue, outside, zero), SB_ERROR_INDEX);
        CHECK_RESULT(ndl_tissue_set_force(tissue, 0, nowhere), SB_ERROR_NOT_FINITE);
        CHECK_RESULT(ndl_tissue_set_gravity(tissue, nowhere), SB_ERROR_NOT_FINITE);
        CHECK_RESULT(ndl_tissue_set_damping(tissue, -1, 0), SB_ERROR_ARGUMENT);
        CHECK_RESULT(ndl_tissue_set_damping(tissue, 0, REAL(INFINITY)), SB_ERROR_NOT_FINITE);
    }
    ndl_tissue_destroy(tissue);
    sb_mesh_free(&mesh);
}

/* A step that goes wrong changes nothing, and the next goes as if it had not been, to the last bit. */
static void test_undone(void)
{
    sb_mesh mesh = small_beam();
    size_t bytes = (size_t)mesh.node_count * sizeof(sb_vec3);
    unsigned long long hash[2] = {0, 1};
    check_bad_numbers();
    for (int fail = 0; fail < 2; fail++) {
        ndl_tissue_def def = tissue_def(&mesh);
        ndl_tissue *tissue;
        sb_error error;
        def.gravity = sb_v3(0, 0, REAL(-9.81));
        tissue = make_tissue(&def);
        if (!tissue)
            continue;
        fix_end(tissue, &mesh);
        for (int s = 0; s < 12; s++) {
            CHECK_OK(ndl_tissue_step(tissue, REAL(0.01), NULL, NULL));
            if (fail && s % 4 == 2) {
                ndl_tissue_mesh *at = ndl_tissue_get_mesh(tissue);
                unsigned long long before =
                    scene_hash(at->x, bytes) ^ scene_hash(at->v, bytes) ^ scene_hash(at->a, bytes);
                CHECK_OK(ndl_tissue_set_force(tissue, mesh.node_count - 1, sb_v3(SB_REAL_MAX, 0, SB_REAL_MAX)));
                CHECK_RESULT(ndl_tissue_step(tissue, REAL(0.01), NULL, &error), SB_ERROR_DIVERGED);
                CHECK((scene_hash(at->x, bytes) ^ scene_hash(at->v, bytes) ^ scene_hash(at->a, bytes)) == before);
                CHECK_OK(ndl_tissue_set_force(tissue, mesh.node_count - 1, sb_v3(0, 0, 0)));
            }
        }
        hash[fail] = scene_hash(ndl_tissue_positions(tissue), bytes) ^ scene_hash(ndl_tissue_velocities(tissue), bytes);
        ndl_tissue_destroy(tissue);
    }
    CHECK(hash[0] == hash[1]);
    sb_mesh_free(&mesh);
}

static void test_memory_at_creation(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 2, 2, 2, sb_v3(REAL(0.02), REAL(0.02), REAL(0.02)), 0);
    ndl_tissue_def def = tissue_def(&mesh);
    scene_memory memory = {0, 0, 0};
    int all;
    ndl_tissue *tissue = NULL;
    sb_error error;
    def.allocator = scene_allocator(&memory);
    CHECK_OK(ndl_tissue_create(&def, &tissue, &error));
    all = memory.calls;
    for (int s = 0; tissue && s < 5; s++)
        CHECK_OK(ndl_tissue_step(tissue, REAL(0.01), NULL, NULL));
    CHECK_INT(memory.calls, all); /* steps ask for nothing */
    ndl_tissue_destroy(tissue);
    CHECK_INT(memory.live, 0);
    for (int k = 1; k <= all; k++) {
        memory.calls = 0;
        memory.fail_at = k;
        tissue = NULL;
        CHECK_RESULT(ndl_tissue_create(&def, &tissue, &error), SB_ERROR_MEMORY);
        CHECK(tissue == NULL);
        CHECK_INT(memory.live, 0);
    }
    sb_mesh_free(&mesh);
}

/* Memory that runs out from some call on, and comes back. */
typedef struct drought {
    int calls, from, live;
} drought;

static void *drought_alloc(void *user, size_t bytes)
{
    drought *d = (drought *)user;
    void *pointer;
    if (++d->calls >= d->from && d->from > 0)
        return NULL;
    pointer = malloc(bytes);
    d->live += pointer != NULL;
    return pointer;
}

static void drought_release(void *user, void *pointer)
{
    ((drought *)user)->live -= pointer != NULL;
    free(pointer);
}

/* Splits without slack while memory fails at call k: the mesh refuses, or the matrix does at the next step; when memory
 * is back all is as it should be. Returns how often each refused. */
static void drought_run(int from, int *mesh_refused, int *step_refused)
{
    visits w;
    drought d = {0, 0, 0};
    sb_mesh mesh = scene_box(SB_TET4, 3, 3, 3, sb_v3(REAL(0.03), REAL(0.03), REAL(0.03)), 0.1);
    ndl_tissue_def def = tissue_def(&mesh);
    def.slack = 0;
    def.allocator.alloc = drought_alloc;
    def.allocator.release = drought_release;
    def.allocator.user = &d;
    if (visits_begin(&w, &def, mesh, 0.01)) {
        ndl_surface_hit hit;
        sb_result result;
        CHECK_OK(ndl_tissue_step(w.tissue, REAL(0.01), NULL, NULL));
        CHECK(ndl_tissue_mesh_hit(w.at, sb_v3(REAL(0.0133), REAL(0.0147), REAL(0.04)),
                                  sb_v3(REAL(0.0133), REAL(0.0147), 0), &hit));
        d.calls = 0;
        d.from = from;
        for (int s = 0; s < 12; s++) {
            result = s == 0 ? ndl_remesh_puncture(w.remesh, 0, &hit, NULL, NULL)
                            : ndl_remesh_penetrate(w.remesh, 0, sb_v3_madd(hit.X, REAL(-0.001 * s), sb_v3(0, 0, 1)),
                                                   NULL, NULL);
            if (result != SB_OK) {
                CHECK_RESULT(result, SB_ERROR_MEMORY);
                ++*mesh_refused;
                d.from = 0;
                s--;
                continue;
            }
            result = ndl_tissue_step(w.tissue, REAL(0.01), NULL, NULL);
            if (result != SB_OK) {
                CHECK_RESULT(result, SB_ERROR_MEMORY);
                ++*step_refused;
                CHECK_RESULT(ndl_tissue_step(w.tissue, REAL(0.01), NULL, NULL), SB_ERROR_MEMORY);
                d.from = 0;
                CHECK_OK(ndl_tissue_step(w.tissue, REAL(0.01), NULL, NULL));
            }
            memcpy(w.x, w.at->x, (size_t)w.at->node_end * sizeof(sb_vec3));
            CHECK_OK(ndl_tissue_step(w.tissue, REAL(0.01), NULL, NULL));
            CHECK(matrix_error(w.tissue, w.at, w.x, gel) < scene_tolerance(1e-11, 500));
        }
    }
    visits_end(&w);
    CHECK_INT(d.live, 0);
}

static void test_memory_of_changes(void)
{
    int mesh_refused = 0, step_refused = 0;
    for (int from = 1; from < 8; from++)
        drought_run(from, &mesh_refused, &step_refused);
    CHECK(mesh_refused > 0);
    CHECK(step_refused > 0);
}

CHECK_SUITE(tissue, {"steps equal sb_body's (Newmark)", test_body_newmark},
            {"steps equal sb_body's (Euler)", test_body_euler},
            {"static rest equals sb_body_solve_static", test_static_rest},
            {"momentum's rate is weight, loads and reactions", test_balance},
            {"a free body keeps its momentum", test_free_body}, {"prescribed nodes", test_prescribed},
            {"200 needles come and go", test_visits}, {"a split mesh", test_split_mesh},
            {"lazy stiffness", test_lazy}, {"iterations do not grow with the mesh", test_iterations},
            {"caps and rest", test_capped}, {"same bits on any number of threads", test_threads},
            {"materials", test_materials}, {"violence comes to rest", test_violence}, {"refusals", test_refusals},
            {"a failed step leaves no trace", test_undone}, {"no memory at creation", test_memory_at_creation},
            {"no memory for changes", test_memory_of_changes});
