/* Batched force, tangent and product of corotated tet4 and tet10 against the loops that take any material. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

/* 270 cells: the last batch is partly filled. */
static sb_mesh box(sb_element_type type)
{
    return scene_box(type, 5, 3, 3, sb_v3(REAL(0.05), REAL(0.03), REAL(0.03)), 0.2);
}

/* The mesh with one more element, far away, in region 1; regions[element_count] of the result. */
static sb_mesh with_stranger(const sb_mesh *mesh, int **regions)
{
    sb_mesh made = *mesh;
    int n = sb_element_node_count(mesh->element_type);
    size_t nodes = (size_t)mesh->node_count, elements = (size_t)mesh->element_count;
    made.nodes = (sb_vec3 *)malloc((nodes + (size_t)n) * sizeof *made.nodes);
    made.elements = (int *)malloc((elements + 1) * (size_t)n * sizeof *made.elements);
    *regions = (int *)calloc(elements + 1, sizeof **regions);
    memcpy(made.nodes, mesh->nodes, nodes * sizeof *made.nodes);
    memcpy(made.elements, mesh->elements, elements * (size_t)n * sizeof *made.elements);
    for (int a = 0; a < n; a++) {
        made.nodes[mesh->node_count + a] = sb_v3_add(mesh->nodes[mesh->elements[a]], sb_v3(1, 0, 0));
        made.elements[n * mesh->element_count + a] = mesh->node_count + a;
    }
    (*regions)[mesh->element_count] = 1;
    made.node_count += n;
    made.element_count++;
    return made;
}

/* What the bodies of a comparison have in common. */
typedef struct scene {
    sb_element_type type;
    int single_rotation;
    int mixed;       /* 1: elements beyond the middle are stiffer and nearly incompressible (region 2) */
    double violence; /* random displacements, in cells */
} scene;

/* A body of the scene with node 0's plane held; strange: with a far element of another model, which no batch takes. */
static sb_body *scene_make(const scene *s, const sb_mesh *mesh, int *regions, int strange, sb_jobs jobs)
{
    sb_body_def def = sb_default_body_def();
    sb_region_material others[2];
    sb_mesh own = *mesh;
    sb_body *body;
    int n = sb_element_node_count(s->type);
    own.regions = regions;
    for (int e = 0; e < mesh->element_count - strange; e++)
        regions[e] = s->mixed && mesh->nodes[mesh->elements[n * e]].x > REAL(0.025) ? 2 : 0;
    others[0].region = 2;
    others[0].material = sb_material_corotated(REAL(4e4), REAL(0.48), REAL(1100));
    others[1].region = 1;
    others[1].material = sb_material_corotated_invertible(REAL(5e3), REAL(0.3), REAL(1000));
    def.mesh = &own;
    def.material = sb_material_corotated(REAL(5e3), REAL(0.4), REAL(1000));
    def.region_materials = others + !s->mixed;
    def.region_material_count = s->mixed + strange;
    def.single_rotation = s->single_rotation;
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.damping_stiffness = REAL(0.01);
    def.tolerance = SB_REAL_IS_FLOAT ? REAL(1e-5) : REAL(1e-13);
    def.max_iterations = 3000;
    def.jobs = jobs;
    body = scene_body(&def);
    scene_fix_plane(body, mesh, 0, 0, SB_XYZ);
    for (int i = 0; i < mesh->node_count; i++)
        if (mesh->nodes[i].x > REAL(0.5))
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, SB_XYZ));
    return body;
}

/* Random displacements of all free nodes, the first `count` nodes of any mesh alike. */
static void shake(sb_body *body, int count, double size, unsigned long long seed)
{
    int n = sb_body_node_count(body);
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)n, sizeof *u);
    for (int i = 0; i < count; i++) {
        sb_vec3 v;
        v.x = REAL(check_random_in(&seed, -size, size));
        v.y = REAL(check_random_in(&seed, -size, size));
        v.z = REAL(check_random_in(&seed, -size, size));
        if (!sb_body_supports(body)[i])
            u[i] = v;
    }
    CHECK_OK(sb_body_set_displacements(body, u));
    free(u);
}

static double largest(const sb_vec3 *a, int count)
{
    double most = 0;
    for (int i = 0; i < count; i++)
        most = fmax(most, (double)sb_v3_norm(a[i]));
    return most;
}

/* Energy, steps and stiffness of a batched body and of one with a stranger, from the same displacements. */
static void compare(const scene *s)
{
    sb_mesh mesh = box(s->type), strange;
    int *regions = NULL, *own = (int *)calloc((size_t)mesh.element_count, sizeof *own), n = mesh.node_count;
    sb_jobs jobs;
    sb_body *a, *b;
    memset(&jobs, 0, sizeof jobs);
    strange = with_stranger(&mesh, &regions);
    a = scene_make(s, &mesh, own, 0, jobs);
    b = scene_make(s, &strange, regions, 1, jobs);
    if (CHECK(a && b)) {
        sb_vec3 *x = (sb_vec3 *)calloc((size_t)strange.node_count, sizeof *x);
        sb_vec3 *ya = (sb_vec3 *)calloc((size_t)strange.node_count, sizeof *ya);
        sb_vec3 *yb = (sb_vec3 *)calloc((size_t)strange.node_count, sizeof *yb);
        unsigned long long seed = 3;
        sb_energy energy[2];
        shake(a, n, s->violence * 0.01, 11);
        shake(b, n, s->violence * 0.01, 11);
        CHECK_OK(sb_body_energy(a, &energy[0]));
        CHECK_OK(sb_body_energy(b, &energy[1]));
        CHECK_NEAR((double)energy[0].elastic, (double)energy[1].elastic,
                   scene_tolerance(1e-12, 100) * (double)energy[1].elastic);
        for (int i = 0; i < n; i++)
            x[i] = sb_v3(REAL(check_random_in(&seed, -1, 1)), REAL(check_random_in(&seed, -1, 1)), 0);
        CHECK_OK(sb_body_multiply_tangent(a, SB_TANGENT_QUASI, x, ya, NULL));
        CHECK_OK(sb_body_multiply_tangent(b, SB_TANGENT_QUASI, x, yb, NULL));
        CHECK_NEAR(scene_distance(ya, yb, n) / largest(yb, n), 0, scene_tolerance(1e-12, 100));
        for (int step = 0; step < 2; step++) {
            CHECK_OK(sb_body_step(a, REAL(0.005), NULL));
            CHECK_OK(sb_body_step(b, REAL(0.005), NULL));
            CHECK_NEAR(scene_distance(sb_body_displacements(a), sb_body_displacements(b), n) /
                           largest(sb_body_displacements(b), n),
                       0, scene_tolerance(1e-9, 1e5));
        }
        CHECK_OK(sb_body_multiply_tangent(a, SB_TANGENT_QUASI, x, ya, NULL)); /* rotations at hand this time */
        CHECK_OK(sb_body_multiply_tangent(b, SB_TANGENT_QUASI, x, yb, NULL));
        CHECK_NEAR(scene_distance(ya, yb, n) / largest(yb, n), 0, scene_tolerance(1e-7, 1e6));
        free(x);
        free(ya);
        free(yb);
    }
    sb_body_destroy(a);
    sb_body_destroy(b);
    sb_mesh_free(&mesh);
    free(strange.nodes);
    free(strange.elements);
    free(regions);
    free(own);
}

static void test_against_generic(void)
{
    static const double violence[] = {0, 0.05, 0.5, 2}; /* at rest, bent, inverted, folded-over */
    static const sb_element_type types[] = {SB_TET4, SB_TET10};
    for (int t = 0; t < 2; t++)
        for (int mixed = 0; mixed < 2; mixed++)
            for (int v = 0; v < 4; v++) {
                scene s = {types[t], 0, mixed, 0};
                s.violence = violence[v];
                compare(&s);
            }
}

/* A body of the box, turned by 40 degrees about a skew axis, without supports. */
static sb_body *turned_body(const sb_mesh *mesh, sb_material material, int single_rotation, sb_jobs jobs)
{
    sb_body_def def = sb_default_body_def();
    sb_mat3 r = sb_quat_to_mat3(sb_quat_normalise(sb_quat_make(REAL(0.94), REAL(0.2), REAL(-0.25), REAL(0.12))));
    sb_vec3 *u = (sb_vec3 *)malloc((size_t)mesh->node_count * sizeof *u);
    sb_body *body;
    def.mesh = mesh;
    def.material = material;
    def.single_rotation = single_rotation;
    def.jobs = jobs;
    body = scene_body(&def);
    for (int i = 0; i < mesh->node_count; i++)
        u[i] = sb_v3_sub(sb_m3_apply(r, mesh->nodes[i]), mesh->nodes[i]);
    CHECK_OK(sb_body_set_displacements(body, u));
    free(u);
    return body;
}

static sb_jobs no_jobs(void)
{
    sb_jobs jobs;
    memset(&jobs, 0, sizeof jobs);
    return jobs;
}

/* Near a turned rest shape R C R^T is the second derivative of the energy, with one rotation per cell or many. */
static void test_energy(void)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET10, SB_TET10};
    for (int t = 0; t < 3; t++) {
        sb_mesh mesh = box(types[t]);
        sb_body *body = turned_body(&mesh, sb_material_corotated(REAL(5e3), REAL(0.4), REAL(1000)), t == 2, no_jobs());
        size_t bytes = (size_t)mesh.node_count * sizeof(sb_vec3);
        sb_vec3 *x = (sb_vec3 *)malloc(bytes), *y = (sb_vec3 *)malloc(bytes), *u = (sb_vec3 *)malloc(bytes);
        unsigned long long seed = 5;
        double work = 0, size = SB_REAL_IS_FLOAT ? 1e-4 : 1e-8;
        sb_energy energy;
        for (int i = 0; i < mesh.node_count; i++)
            x[i] = sb_v3(REAL(check_random_in(&seed, -size, size)), REAL(check_random_in(&seed, -size, size)),
                         REAL(check_random_in(&seed, -size, size)));
        CHECK_OK(sb_body_multiply_stiffness(body, x, y, NULL));
        for (int i = 0; i < mesh.node_count; i++) {
            work += 0.5 * (double)sb_v3_dot(x[i], y[i]);
            u[i] = sb_v3_add(sb_body_displacements(body)[i], x[i]);
        }
        CHECK_OK(sb_body_set_displacements(body, u));
        CHECK_OK(sb_body_energy(body, &energy));
        CHECK_NEAR((double)energy.elastic / work, 1, SB_REAL_IS_FLOAT ? 0.1 : 1e-4);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(x);
        free(y);
        free(u);
    }
}

/* Small displacements are linear elasticity's, whatever stands for the rotation: one step from rest each. */
static void test_single_rotation(void)
{
    sb_mesh mesh = box(SB_TET10);
    sb_body_def def = sb_default_body_def();
    sb_body *bodies[2];
    for (int k = 0; k < 2; k++) {
        def.mesh = &mesh;
        def.material = k ? sb_material_linear(REAL(5e6), REAL(0.4), REAL(1000))
                         : sb_material_corotated(REAL(5e6), REAL(0.4), REAL(1000));
        def.single_rotation = !k;
        def.tolerance = SB_REAL_IS_FLOAT ? REAL(1e-5) : REAL(1e-12);
        bodies[k] = scene_body(&def);
        scene_fix_plane(bodies[k], &mesh, 0, 0, SB_XYZ);
        shake(bodies[k], mesh.node_count, SB_REAL_IS_FLOAT ? 1e-6 : 1e-9, 21); /* what differs is of second order */
        for (int step = 0; step < (SB_REAL_IS_FLOAT ? 1 : 3); step++)
            CHECK_OK(sb_body_step(bodies[k], REAL(1e-3), NULL));
    }
    CHECK_NEAR(scene_distance(sb_body_displacements(bodies[0]), sb_body_displacements(bodies[1]), mesh.node_count) /
                   largest(sb_body_displacements(bodies[1]), mesh.node_count),
               0, SB_REAL_IS_FLOAT ? 0.05 : 1e-4);
    sb_body_destroy(bodies[0]);
    sb_body_destroy(bodies[1]);
    sb_mesh_free(&mesh);
}

static unsigned long long play(sb_element_type type, int single_rotation, int mixed, sb_jobs jobs)
{
    sb_mesh mesh = box(type);
    scene s = {type, 0, 0, 0};
    int *regions = (int *)calloc((size_t)mesh.element_count, sizeof *regions);
    size_t bytes = (size_t)mesh.node_count * sizeof(sb_vec3);
    sb_vec3 *y = (sb_vec3 *)malloc(bytes);
    unsigned long long hash = 0;
    sb_body *body;
    s.single_rotation = single_rotation;
    s.mixed = mixed;
    body = scene_make(&s, &mesh, regions, 0, jobs);
    shake(body, mesh.node_count, 0.005, 31);
    for (int step = 0; step < 2; step++) {
        CHECK_OK(sb_body_step(body, REAL(0.005), NULL));
        CHECK_OK(sb_body_multiply_tangent(body, SB_TANGENT_QUASI, sb_body_velocities(body), y, NULL));
        hash = hash * 31 + (scene_hash(sb_body_displacements(body), bytes) ^ scene_hash(y, bytes));
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(regions);
    free(y);
    return hash;
}

static void test_threads(void)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET10, SB_TET10};
    static const int workers[] = {1, 2, 3, 7};
    for (int t = 0; t < 3; t++)
        for (int w = 0; w < 4; w++) {
            int count = workers[w];
            CHECK(play(types[t], t == 2, t != 2, scene_jobs(&count)) == play(types[t], t == 2, t != 2, no_jobs()));
        }
}

/* A new model of material changes the loops, and back: the body goes on as one that never was anything else. */
static void test_change_of_material(void)
{
    sb_material soft = sb_material_corotated(REAL(5e3), REAL(0.4), REAL(1000)), other = soft;
    sb_mesh mesh = box(SB_TET10);
    size_t bytes = (size_t)mesh.node_count * sizeof(sb_vec3);
    sb_vec3 *x = (sb_vec3 *)calloc(1, bytes), *y[3];
    sb_body *body = turned_body(&mesh, soft, 0, no_jobs());
    other.model = SB_COROTATED_INVERTIBLE;
    for (int i = 0; i < mesh.node_count; i++)
        x[i] = sb_v3(mesh.nodes[i].y, -mesh.nodes[i].z * mesh.nodes[i].x, 0);
    for (int k = 0; k < 3; k++) {
        y[k] = (sb_vec3 *)malloc(bytes);
        CHECK_OK(sb_body_set_material(body, k == 1 ? &other : &soft, NULL));
        CHECK_OK(sb_body_multiply_stiffness(body, x, y[k], NULL));
    }
    CHECK(memcmp(y[0], y[2], bytes) == 0);
    CHECK_NEAR(scene_distance(y[0], y[1], mesh.node_count) / largest(y[0], mesh.node_count), 0,
               scene_tolerance(1e-10, 1e4));
    for (int k = 0; k < 3; k++)
        free(y[k]);
    free(x);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_product_failures(void)
{
    sb_mesh mesh = box(SB_TET10);
    int n = mesh.node_count;
    sb_vec3 *x = (sb_vec3 *)calloc((size_t)n, sizeof *x), *y = (sb_vec3 *)calloc((size_t)n, sizeof *y);
    sb_vec3 *untouched = (sb_vec3 *)calloc((size_t)n, sizeof *untouched);
    sb_body *body = turned_body(&mesh, sb_material_neo_hookean(REAL(5e3), REAL(0.4), REAL(1000)), 0, no_jobs());
    sb_error error;
    uint64_t hash = sb_body_state_hash(body);
    x[7].y = 1;
    CHECK_OK(sb_body_multiply_stiffness(body, x, y, NULL));
    CHECK(largest(y, n) > 0 && sb_body_state_hash(body) == hash); /* a question does not change the body */
    memset(y, 0, (size_t)n * sizeof *y);
    CHECK_RESULT(sb_body_multiply_stiffness(NULL, x, y, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_multiply_stiffness(body, NULL, y, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_multiply_stiffness(body, x, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_multiply_tangent(body, (sb_tangent_kind)3, x, y, &error), SB_ERROR_ARGUMENT);
    x[7].y = REAL(NAN);
    CHECK_RESULT(sb_body_multiply_stiffness(body, x, y, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.node, 7);
    x[7].y = 1;
    shake(body, n, 0.02, 41);
    hash = sb_body_state_hash(body);
    CHECK_RESULT(sb_body_multiply_stiffness(body, x, y, &error), SB_ERROR_INVERTED);
    CHECK(error.element >= 0 && error.element < mesh.element_count);
    CHECK(sb_body_state_hash(body) == hash && memcmp(y, untouched, (size_t)n * sizeof *y) == 0);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(x);
    free(y);
    free(untouched);
}

/* ---- products against differences of forces ---- */

/* Internal forces at u: what supports of all nodes exert. */
static void forces_at(sb_body *body, const int *all, const sb_vec3 *u, sb_vec3 *f)
{
    int n = sb_body_node_count(body);
    sb_static_options options = sb_default_static_options();
    options.instantaneous = 1;
    CHECK_OK(sb_body_prescribe(body, all, n, SB_XYZ, u, 0));
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    memcpy(f, sb_body_reactions(body), (size_t)n * sizeof *f);
}

/* A shape stretched by up to a quarter, turned, and shaken by `size`. */
static void deform(const sb_mesh *mesh, double size, unsigned long long seed, sb_vec3 *u)
{
    sb_mat3 f = sb_quat_to_mat3(sb_quat_normalise(sb_quat_make(REAL(0.9), REAL(0.3), REAL(-0.2), REAL(0.25))));
    for (int i = 0; i < mesh->node_count; i++) {
        sb_vec3 x = mesh->nodes[i], y;
        y = sb_v3(REAL(1.25) * x.x + REAL(0.1) * x.y, REAL(0.85) * x.y, x.z * REAL(0.8) + REAL(0.15) * x.x);
        u[i] = sb_v3_sub(sb_m3_apply(f, y), x);
        u[i].x += REAL(check_random_in(&seed, -size, size));
        u[i].y += REAL(check_random_in(&seed, -size, size));
        u[i].z += REAL(check_random_in(&seed, -size, size));
    }
}

static sb_material model_of(int model)
{
    const sb_real g[2] = {REAL(0.3), REAL(0.4)}, tau[2] = {REAL(0.1), REAL(2)};
    switch (model) {
    case 0: return sb_material_linear(REAL(5e3), REAL(0.4), REAL(1000));
    case 1: return sb_material_corotated(REAL(5e3), REAL(0.4), REAL(1000));
    case 2: return sb_material_corotated_invertible(REAL(5e3), REAL(0.4), REAL(1000));
    case 3: return sb_material_svk(REAL(5e3), REAL(0.4), REAL(1000));
    case 4: return sb_material_neo_hookean(REAL(5e3), REAL(0.4), REAL(1000));
    case 5: return sb_material_neo_hookean_isochoric(REAL(900), REAL(1e-4), REAL(1000));
    case 6: return sb_material_stable_neo_hookean(REAL(5e3), REAL(0.4), REAL(1000));
    case 7: return sb_material_mooney_rivlin(REAL(600), REAL(300), REAL(1e-4), REAL(1000));
    case 8: return sb_material_reduced_polynomial(REAL(900), REAL(100), REAL(50), REAL(1e-4), REAL(1000));
    case 9: return sb_material_with_fibres(model_of(5), REAL(500), REAL(0.7));
    case 10: return sb_material_with_prony(model_of(4), g, tau, 2);
    default: return sb_material_with_prony(model_of(9), g, tau, 2);
    }
}
enum { MODELS = 12 };

/* Relative difference between K x and the central difference of the forces along x. With Prony terms the body has
 * something to remember: it was held stretched for a while. */
static double stiffness_error(sb_element_type type, sb_integration integration, int single_rotation, int model,
                              unsigned long long seed)
{
    sb_mesh mesh = scene_box(type, 2, 2, 1, sb_v3(REAL(0.02), REAL(0.02), REAL(0.01)), 0.2);
    int n = mesh.node_count, *all = (int *)malloc((size_t)n * sizeof *all);
    size_t bytes = (size_t)n * sizeof(sb_vec3);
    double step = SB_REAL_IS_FLOAT ? 3e-5 : 1e-8, error = 0, size = 0;
    sb_vec3 *fibres = (sb_vec3 *)malloc((size_t)mesh.element_count * sizeof *fibres);
    sb_vec3 *u = (sb_vec3 *)malloc(bytes), *x = (sb_vec3 *)malloc(bytes), *v = (sb_vec3 *)malloc(bytes);
    sb_vec3 *y = (sb_vec3 *)malloc(bytes), *low = (sb_vec3 *)malloc(bytes), *high = (sb_vec3 *)malloc(bytes);
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    for (int e = 0; e < mesh.element_count; e++)
        fibres[e] = sb_v3(1, REAL(0.3), REAL(e % 2 - 0.5));
    def.mesh = &mesh;
    def.material = model_of(model);
    def.fibres = fibres;
    def.integration = integration;
    def.single_rotation = single_rotation;
    body = scene_body(&def);
    for (int i = 0; i < n; i++) {
        all[i] = i;
        x[i] = sb_v3(REAL(check_random_in(&seed, -1, 1)), REAL(check_random_in(&seed, -1, 1)),
                     REAL(check_random_in(&seed, -1, 1)));
    }
    deform(&mesh, 2e-4, seed + 1, u);
    CHECK_OK(sb_body_prescribe(body, all, n, SB_XYZ, u, 0));
    for (int k = 0; k < 3; k++)
        CHECK_OK(sb_body_step(body, REAL(0.1), NULL));
    deform(&mesh, 5e-4, seed + 2, u);
    forces_at(body, all, u, low);
    CHECK_OK(sb_body_multiply_stiffness(body, x, y, NULL));
    for (int side = -1; side <= 1; side += 2) {
        for (int i = 0; i < n; i++)
            v[i] = sb_v3_madd(u[i], REAL(side * step), x[i]);
        forces_at(body, all, v, side < 0 ? low : high);
    }
    for (int i = 0; i < n; i++) {
        sb_vec3 d = sb_v3_scale(REAL(0.5 / step), sb_v3_sub(high[i], low[i]));
        error = fmax(error, (double)sb_v3_norm(sb_v3_sub(d, y[i])));
        size = fmax(size, (double)sb_v3_norm(d));
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(all);
    free(fibres);
    free(u);
    free(x);
    free(v);
    free(y);
    free(low);
    free(high);
    return error / size;
}

/* All elements and materials, in shapes whose tangents are not positive definite. */
static void test_differences(void)
{
    static const sb_element_type types[] = {SB_TET4, SB_TET10, SB_TET10, SB_HEX8, SB_HEX8, SB_HEX20, SB_HEX27};
    static const sb_integration rules[] = {SB_INTEGRATION_AUTO, SB_INTEGRATION_AUTO, SB_INTEGRATION_CURVED,
                                           SB_INTEGRATION_AUTO, SB_INTEGRATION_BBAR, SB_INTEGRATION_AUTO,
                                           SB_INTEGRATION_AUTO};
    for (int t = 0; t < 7; t++)
        for (int model = 0; model < MODELS; model++)
            CHECK_NEAR(stiffness_error(types[t], rules[t], 0, model, 100 + (unsigned long long)(MODELS * t + model)), 0,
                       SB_REAL_IS_FLOAT ? 0.02 : 1e-6);
}

/* ---- one rotation per cell ---- */

/* Forces of cells with one rotation are the slope of their energy, and neither push nor turn the body. */
static void conserve(sb_integration integration, unsigned long long seed)
{
    sb_mesh mesh = scene_box(SB_TET10, 2, 2, 1, sb_v3(REAL(0.02), REAL(0.02), REAL(0.01)), 0.2);
    int n = mesh.node_count, *all = (int *)malloc((size_t)n * sizeof *all);
    size_t bytes = (size_t)n * sizeof(sb_vec3);
    double step = SB_REAL_IS_FLOAT ? 1e-5 : 1e-8, size = 0, slope = 0, work = 0, works = 0;
    sb_vec3 *u = (sb_vec3 *)malloc(bytes), *v = (sb_vec3 *)malloc(bytes), *f = (sb_vec3 *)malloc(bytes);
    sb_vec3 sum = sb_v3(0, 0, 0), torque = sum;
    sb_body_def def = sb_default_body_def();
    sb_body *body;
    def.mesh = &mesh;
    def.material = model_of(1);
    def.integration = integration;
    def.single_rotation = 1;
    body = scene_body(&def);
    deform(&mesh, 3e-4, seed, u);
    for (int i = 0; i < n; i++)
        all[i] = i;
    forces_at(body, all, u, f);
    for (int i = 0; i < n; i++) {
        sum = sb_v3_add(sum, f[i]);
        torque = sb_v3_add(torque, sb_v3_cross(sb_body_positions(body)[i], f[i]));
        size += (double)sb_v3_norm(f[i]);
    }
    CHECK_NEAR((double)sb_v3_norm(sum) / size, 0, scene_tolerance(1e-13, 10));
    CHECK_NEAR((double)sb_v3_norm(torque) / (size * 0.02), 0, scene_tolerance(1e-12, 100));
    for (int side = -1; side <= 1; side += 2) {
        unsigned long long way = seed + 7;
        sb_energy energy;
        for (int i = 0; i < n; i++) {
            sb_vec3 x = sb_v3(REAL(check_random_in(&way, -1, 1)), REAL(check_random_in(&way, -1, 1)),
                              REAL(check_random_in(&way, -1, 1)));
            v[i] = sb_v3_madd(u[i], REAL(side * step), x);
            work += side < 0 ? 0 : (double)sb_v3_dot(f[i], x);
            works += side < 0 ? 0 : fabs((double)sb_v3_dot(f[i], x));
        }
        CHECK_OK(sb_body_set_displacements(body, v));
        CHECK_OK(sb_body_energy(body, &energy));
        slope += side * (double)energy.elastic / (2 * step);
    }
    CHECK_NEAR((slope - work) / works, 0, SB_REAL_IS_FLOAT ? 0.03 : 1e-5);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(all);
    free(u);
    free(v);
    free(f);
}

static void test_conservative(void)
{
    for (unsigned long long seed = 1; seed <= 5; seed++) {
        conserve(SB_INTEGRATION_AUTO, seed);
        conserve(SB_INTEGRATION_CURVED, seed);
    }
    /* K is that of a rotation at each point: near, while the cells' points turn alike */
    CHECK_NEAR(stiffness_error(SB_TET10, SB_INTEGRATION_AUTO, 1, 1, 3), 0, 0.15);
}

CHECK_SUITE(assembly, {"batches against single cells", test_against_generic}, {"stiffness against energy", test_energy},
            {"single rotation", test_single_rotation}, {"stiffness against differences", test_differences},
            {"single rotation keeps momentum and energy", test_conservative}, {"threads", test_threads},
            {"change of material", test_change_of_material}, {"product: failures", test_product_failures});
