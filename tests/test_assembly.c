/* Batched force, tangent and product of corotated tet4 and tet10 against the loops that take any material. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

/* 270 cells: the last batch is partly filled. */
static sb_mesh box(sb_element_type type) { return scene_box(type, 5, 3, 3, sb_v3(REAL(0.05), REAL(0.03), REAL(0.03)), 0.2); }

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
    int mixed;            /* 1: elements beyond the middle are stiffer and nearly incompressible (region 2) */
    double violence;      /* random displacements, in cells */
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

/* Steps and stiffness of a batched body and of one with a stranger, from the same displacements. */
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
        shake(a, n, s->violence * 0.01, 11);
        shake(b, n, s->violence * 0.01, 11);
        for (int i = 0; i < n; i++)
            x[i] = sb_v3(REAL(check_random_in(&seed, -1, 1)), REAL(check_random_in(&seed, -1, 1)), 0);
        CHECK_OK(sb_body_multiply_stiffness(a, x, ya, NULL));
        CHECK_OK(sb_body_multiply_stiffness(b, x, yb, NULL));
        CHECK_NEAR(scene_distance(ya, yb, n) / largest(yb, n), 0, scene_tolerance(1e-12, 100));
        for (int step = 0; step < 2; step++) {
            CHECK_OK(sb_body_step(a, REAL(0.005), NULL));
            CHECK_OK(sb_body_step(b, REAL(0.005), NULL));
            CHECK_NEAR(scene_distance(sb_body_displacements(a), sb_body_displacements(b), n) /
                           largest(sb_body_displacements(b), n), 0, scene_tolerance(1e-9, 1e5));
        }
        CHECK_OK(sb_body_multiply_stiffness(a, x, ya, NULL)); /* rotations at hand this time */
        CHECK_OK(sb_body_multiply_stiffness(b, x, yb, NULL));
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
    static const double violence[] = {0, 0.05, 0.5, 2}; /* at rest, bent, inverted, knotted */
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
        shake(bodies[k], mesh.node_count, SB_REAL_IS_FLOAT ? 1e-5 : 1e-8, 21);
        for (int step = 0; step < 3; step++)
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
        CHECK_OK(sb_body_multiply_stiffness(body, sb_body_velocities(body), y, NULL));
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

CHECK_SUITE(assembly, {"batches against single cells", test_against_generic}, {"stiffness against energy", test_energy},
            {"single rotation", test_single_rotation}, {"threads", test_threads},
            {"change of material", test_change_of_material}, {"product: failures", test_product_failures});
