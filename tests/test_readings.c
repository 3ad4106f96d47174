/* Readings: tensors at nodes against fields that they must give exactly, energies against the body's, the stiffness
 * as a matrix against its products, and what is refused. */
#include "scene.h"

static const sb_element_type types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
enum { TYPES = (int)(sizeof types / sizeof types[0]) };

static sb_mat3 random_matrix(unsigned long long *seed, double size)
{
    sb_mat3 m = sb_m3_identity();
    for (int i = 0; i < 9; i++)
        m.m[i / 3][i % 3] += REAL(check_random_in(seed, -size, size));
    return m;
}

static double matrix_distance(sb_mat3 a, sb_mat3 b)
{
    sb_mat3 d = sb_m3_sub(a, b);
    return sqrt((double)sb_m3_ddot(d, d));
}

/* Displacements (F - I) X. */
static void stretch_body(sb_body *body, const sb_mesh *mesh, sb_mat3 f)
{
    sb_vec3 *u = (sb_vec3 *)malloc((size_t)mesh->node_count * sizeof *u);
    for (int i = 0; i < mesh->node_count; i++)
        u[i] = sb_v3_sub(sb_m3_apply(f, mesh->nodes[i]), mesh->nodes[i]);
    CHECK_OK(sb_body_set_displacements(body, u));
    free(u);
}

static sb_material random_model(unsigned long long *seed)
{
    switch ((int)check_random_in(seed, 0, 5)) {
    case 0: return sb_material_linear(5000, REAL(0.4), 1000);
    case 1: return sb_material_corotated(5000, REAL(0.4), 1000);
    case 2: return sb_material_svk(5000, REAL(0.3), 1000);
    case 3: return sb_material_neo_hookean(5000, REAL(0.45), 1000);
    default: return sb_material_mooney_rivlin(500, 200, REAL(1e-4), 1000);
    }
}

/* A homogeneous deformation is the same at every node, point and element, as the material has it. */
static void test_homogeneous(void)
{
    unsigned long long seed = 91;
    for (int round = 0; round < 3 * TYPES; round++) {
        sb_mesh mesh = scene_box(types[round % TYPES], 3, 2, 2, sb_v3(REAL(0.06), REAL(0.05), REAL(0.04)), 0.2);
        sb_mat3 f = random_matrix(&seed, 0.15), point, stress, strain, *values;
        sb_real *densities = (sb_real *)malloc((size_t)mesh.element_count * sizeof *densities), energy = 0;
        sb_body_def def = sb_default_body_def();
        sb_body *body;
        sb_error error;
        def.mesh = &mesh;
        def.material = random_model(&seed);
        def.integration =
            round >= 2 * TYPES && types[round % TYPES] != SB_TET4 ? SB_INTEGRATION_BBAR : SB_INTEGRATION_STANDARD;
        body = scene_body(&def);
        values = (sb_mat3 *)malloc((size_t)mesh.node_count * sizeof *values);
        stretch_body(body, &mesh, f);
        CHECK(sb_material_stress(&def.material, &f, NULL, &stress));
        CHECK(sb_material_energy(&def.material, &f, NULL, &energy));
        stress = sb_material_cauchy_stress(&def.material, f, stress);
        strain = sb_m3_scale(REAL(0.5), sb_m3_sub(sb_m3_tmul(f, f), sb_m3_identity()));
        if (def.material.model == SB_LINEAR)
            strain = sb_m3_sub(sb_m3_scale(REAL(0.5), sb_m3_add(f, sb_m3_transpose(f))), sb_m3_identity());
        CHECK_OK(sb_body_deformation(body, mesh.element_count - 1, sb_body_point_count(body) - 1, &point));
        CHECK_NEAR(matrix_distance(point, f), 0, scene_tolerance(1e-12, 200));
        CHECK_OK(sb_body_strain(body, 0, 0, &point));
        CHECK_NEAR(matrix_distance(point, strain), 0, scene_tolerance(1e-12, 200));
        CHECK_OK(sb_body_nodal_tensors(body, SB_TENSOR_STRAIN, values, &error));
        for (int i = 0; i < mesh.node_count; i++)
            CHECK_NEAR(matrix_distance(values[i], strain), 0, scene_tolerance(1e-12, 500));
        CHECK_OK(sb_body_nodal_tensors(body, SB_TENSOR_STRESS, values, &error));
        for (int i = 0; i < mesh.node_count; i++)
            CHECK_NEAR(matrix_distance(values[i], stress), 0, scene_tolerance(1e-12, 500) * 1e5);
        CHECK_OK(sb_body_energy_densities(body, densities, &error));
        for (int e = 0; e < mesh.element_count; e++)
            CHECK_NEAR(densities[e], energy, scene_tolerance(1e-11, 500) * 1e4);
        sb_body_destroy(body);
        free(values);
        free(densities);
        sb_mesh_free(&mesh);
    }
}

/* Where strain is linear in space, so are the fits: nodes of straight quadratic elements have it exactly. */
static void test_linear_strain(void)
{
    static const sb_element_type quadratic[3] = {SB_TET10, SB_HEX20, SB_HEX27};
    unsigned long long seed = 5;
    for (int t = 0; t < 3; t++) {
        sb_mesh mesh = scene_box(quadratic[t], 3, 2, 2, sb_v3(3, 2, 2), t == 0 ? 0.2 : 0);
        sb_mat3 curve[3], *values = (sb_mat3 *)malloc((size_t)mesh.node_count * sizeof *values);
        sb_vec3 *u = (sb_vec3 *)malloc((size_t)mesh.node_count * sizeof *u);
        sb_body_def def = sb_default_body_def();
        sb_body *body;
        def.mesh = &mesh;
        def.material = sb_material_linear(5000, REAL(0.3), 1000);
        def.integration = SB_INTEGRATION_STANDARD;
        body = scene_body(&def);
        for (int i = 0; i < 3; i++)
            curve[i] = sb_m3_sub(random_matrix(&seed, 0.1), sb_m3_identity());
        for (int i = 0; i < mesh.node_count; i++) /* u_i = X . curve_i X */
            u[i] = sb_v3(sb_v3_dot(mesh.nodes[i], sb_m3_apply(curve[0], mesh.nodes[i])),
                         sb_v3_dot(mesh.nodes[i], sb_m3_apply(curve[1], mesh.nodes[i])),
                         sb_v3_dot(mesh.nodes[i], sb_m3_apply(curve[2], mesh.nodes[i])));
        CHECK_OK(sb_body_set_displacements(body, u));
        CHECK_OK(sb_body_nodal_tensors(body, SB_TENSOR_STRAIN, values, NULL));
        for (int i = 0; i < mesh.node_count; i++) {
            sb_mat3 slope;
            for (int k = 0; k < 3; k++) {
                sb_vec3 row = sb_m3_apply(sb_m3_add(curve[k], sb_m3_transpose(curve[k])), mesh.nodes[i]);
                slope.m[k][0] = row.x, slope.m[k][1] = row.y, slope.m[k][2] = row.z;
            }
            slope = sb_m3_scale(REAL(0.5), sb_m3_add(slope, sb_m3_transpose(slope)));
            CHECK_NEAR(matrix_distance(values[i], slope), 0, scene_tolerance(1e-12, 2000));
        }
        sb_body_destroy(body);
        free(values);
        free(u);
        sb_mesh_free(&mesh);
    }
}

/* Two materials in series, pulled: each region has its own strain up to the face between them, and one stress. */
static void test_regions(void)
{
    sb_mesh mesh = scene_box(SB_TET10, 4, 2, 2, sb_v3(REAL(0.4), REAL(0.1), REAL(0.1)), 0);
    int *regions = (int *)calloc((size_t)mesh.element_count, sizeof *regions);
    sb_region_material stiff;
    sb_mat3 *values = (sb_mat3 *)malloc((size_t)mesh.node_count * sizeof *values);
    sb_body_def def = sb_default_body_def();
    sb_error error;
    sb_body *body;
    int between = -1;
    for (int e = 0; e < mesh.element_count; e++) {
        sb_real middle = 0;
        for (int a = 0; a < 4; a++)
            middle += mesh.nodes[mesh.elements[10 * e + a]].x / 4;
        regions[e] = middle > REAL(0.2) ? -3 : 7;
    }
    mesh.regions = regions;
    stiff.region = -3;
    stiff.material = sb_material_linear(10000, 0, 1000);
    def.mesh = &mesh;
    def.material = sb_material_linear(5000, 0, 1000);
    def.region_materials = &stiff;
    def.region_material_count = 1;
    body = scene_body(&def);
    mesh.regions = NULL;
    free(regions);
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 u = sb_v3(0, 0, 0);
        double x = (double)mesh.nodes[i].x;
        u.x = REAL(x < 0.2 ? 0.02 * x : 0.004 + 0.01 * (x - 0.2));
        CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &u, 1));
        if (fabs(x - 0.2) < 1e-6)
            between = i;
    }
    CHECK_OK(sb_body_solve_static(body, NULL, NULL));
    CHECK_OK(sb_body_region_tensors(body, 7, SB_TENSOR_STRAIN, values, &error));
    CHECK_NEAR(values[between].m[0][0], 0.02, scene_tolerance(1e-10, 1e3));
    CHECK_NEAR(values[mesh.node_count - 1].m[0][0] + values[0].m[1][1], 0, scene_tolerance(1e-10, 1e3));
    CHECK_OK(sb_body_region_tensors(body, -3, SB_TENSOR_STRAIN, values, &error));
    CHECK_NEAR(values[between].m[0][0], 0.01, scene_tolerance(1e-10, 1e3));
    CHECK_OK(sb_body_nodal_tensors(body, SB_TENSOR_STRESS, values, &error));
    for (int i = 0; i < mesh.node_count; i++)
        CHECK_NEAR(values[i].m[0][0], 100, scene_tolerance(1e-7, 1e5));
    CHECK_RESULT(sb_body_region_tensors(body, 1, SB_TENSOR_STRAIN, values, &error), SB_ERROR_INDEX);
    CHECK(strstr(error.message, "region 1") != NULL);
    sb_body_destroy(body);
    free(values);
    sb_mesh_free(&mesh);
}

/* Densities times volumes are the body's energy, in random states that steps led to, Prony terms included. */
static void test_energies_sum(void)
{
    unsigned long long seed = 17;
    for (int t = 0; t < TYPES; t++) {
        const sb_real g = REAL(0.4), tau = REAL(0.05);
        sb_mesh mesh = scene_box(types[t], 3, 2, 2, sb_v3(REAL(0.06), REAL(0.05), REAL(0.04)), 0.2);
        sb_real *densities = (sb_real *)malloc((size_t)mesh.element_count * sizeof *densities);
        sb_body_def def = sb_default_body_def();
        sb_energy energy = {0, 0, 0};
        double sum = 0;
        sb_body *body;
        def.mesh = &mesh;
        def.material = random_model(&seed);
        def.gravity = sb_v3(0, 30, -50);
        if (sb_material_is_hyperelastic(def.material.model))
            def.material = sb_material_with_prony(def.material, &g, &tau, 1);
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        for (int i = 0; i < 4; i++)
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        CHECK_OK(sb_body_energy_densities(body, densities, NULL));
        CHECK_OK(sb_body_energy(body, &energy));
        for (int e = 0; e < mesh.element_count; e++)
            sum += (double)densities[e] * (double)sb_mesh_element_volume(&mesh, e);
        CHECK(energy.elastic > 0);
        CHECK_NEAR(sum / (double)energy.elastic, 1, scene_tolerance(1e-11, 1e4));
        sb_body_destroy(body);
        free(densities);
        sb_mesh_free(&mesh);
    }
}

/* The matrix times a vector is the product, to the last bit, and the state goes on as if nobody had looked. */
static void test_matrix(void)
{
    unsigned long long seed = 23;
    for (int t = 0; t < TYPES; t++) {
        sb_mesh mesh = scene_box(types[t], 3, 2, 2, sb_v3(REAL(0.06), REAL(0.05), REAL(0.04)), 0.2);
        size_t bytes = (size_t)mesh.node_count * sizeof(sb_vec3);
        sb_vec3 *x = (sb_vec3 *)malloc(bytes), *y = (sb_vec3 *)malloc(bytes), *z = (sb_vec3 *)malloc(bytes);
        const sb_matrix *matrix = NULL;
        sb_body_def def = sb_default_body_def();
        sb_body *body, *other;
        def.mesh = &mesh;
        def.material = random_model(&seed);
        def.gravity = sb_v3(0, 3, -9);
        body = scene_body(&def);
        other = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        scene_fix_plane(other, &mesh, 0, 0, SB_XYZ);
        for (int i = 0; i < mesh.node_count; i++)
            x[i] = sb_v3(REAL(check_random_in(&seed, -1, 1)), REAL(check_random_in(&seed, -1, 1)), 1);
        for (int step = 0; step < 3; step++) {
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
            CHECK_OK(sb_body_step(other, REAL(0.01), NULL));
            for (int kind = SB_TANGENT_EXACT; kind <= SB_TANGENT_SPD; kind++) {
                CHECK_OK(sb_body_multiply_tangent(body, (sb_tangent_kind)kind, x, y, NULL));
                CHECK_OK(sb_body_stiffness_matrix(body, (sb_tangent_kind)kind, &matrix, NULL));
                CHECK_INT(matrix->row_count, mesh.node_count);
                sb_matrix_multiply(matrix, &x[0].x, &z[0].x, NULL);
                CHECK(memcmp(y, z, bytes) == 0);
            }
        }
        CHECK(memcmp(sb_body_positions(body), sb_body_positions(other), bytes) == 0);
        matrix = NULL;
        CHECK_RESULT(sb_body_stiffness_matrix(body, (sb_tangent_kind)9, &matrix, NULL), SB_ERROR_ARGUMENT);
        CHECK(!matrix);
        sb_body_destroy(body);
        sb_body_destroy(other);
        free(x);
        free(y);
        free(z);
        sb_mesh_free(&mesh);
    }
}

/* Cells that were removed leave nodes and elements without a reading, and no trace in others. */
static void test_changed_mesh(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 6, 3, 3, sb_v3(REAL(0.06), REAL(0.03), REAL(0.03)), 0);
    sb_body *body = scene_changing_body(&mesh, sb_material_neo_hookean(5000, REAL(0.4), 1000));
    unsigned long long seed = 3;
    sb_mat3 f = random_matrix(&seed, 0.1), stress, *values;
    sb_real *densities, energy = 0;
    int cells;
    scene_remove_cells(body);
    cells = sb_body_element_count(body);
    values = (sb_mat3 *)malloc((size_t)sb_body_node_count(body) * sizeof *values);
    densities = (sb_real *)malloc((size_t)cells * sizeof *densities);
    stretch_body(body, &mesh, f);
    {
        sb_material material = sb_material_neo_hookean(5000, REAL(0.4), 1000);
        CHECK(sb_material_stress(&material, &f, NULL, &stress));
        CHECK(sb_material_energy(&material, &f, NULL, &energy));
    }
    stress = sb_cauchy_stress(f, stress);
    CHECK_OK(sb_body_nodal_tensors(body, SB_TENSOR_STRESS, values, NULL));
    for (int i = 0; i < mesh.node_count; i++)
        CHECK_NEAR(matrix_distance(values[i], stress), 0, scene_tolerance(1e-12, 500) * 1e5);
    CHECK_OK(sb_body_energy_densities(body, densities, NULL));
    for (int e = 0; e < cells; e++)
        CHECK_NEAR(densities[e], sb_body_cell_in_use(body, e) ? energy : 0, scene_tolerance(1e-11, 500) * 1e4);
    sb_body_destroy(body);
    free(values);
    free(densities);
    sb_mesh_free(&mesh);
}

/* A state that the material does not admit has strains but neither stresses nor energies; nothing is written. */
static void test_inverted(void)
{
    sb_mesh mesh = scene_box(SB_HEX8, 2, 1, 1, sb_v3(2, 1, 1), 0);
    sb_body_def def = sb_default_body_def();
    sb_mat3 f = sb_m3_identity(), values[12];
    sb_real densities[2] = {-1, -1};
    sb_error error;
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_neo_hookean(5000, REAL(0.4), 1000);
    body = scene_body(&def);
    f.m[0][0] = -1;
    stretch_body(body, &mesh, f);
    memset(values, 0, sizeof values);
    values[0].m[0][1] = 5;
    CHECK_RESULT(sb_body_nodal_tensors(body, SB_TENSOR_STRESS, values, &error), SB_ERROR_INVERTED);
    CHECK_INT(error.element, 0);
    CHECK_RESULT(sb_body_energy_densities(body, densities, &error), SB_ERROR_INVERTED);
    CHECK(values[0].m[0][1] == 5 && densities[0] == -1 && densities[1] == -1);
    CHECK_OK(sb_body_nodal_tensors(body, SB_TENSOR_STRAIN, values, &error));
    CHECK_NEAR(values[0].m[0][0], 0, 1e-6);
    CHECK_RESULT(sb_body_nodal_tensors(body, 3, values, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_deformation(body, 2, 0, &f), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_deformation(body, 0, 8, &f), SB_ERROR_INDEX);
    CHECK_RESULT(sb_body_strain(body, -1, 0, &f), SB_ERROR_INDEX);
    CHECK(f.m[0][0] == -1);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(readings, {"homogeneous deformations", test_homogeneous}, {"linear strains at nodes", test_linear_strain},
            {"regions apart", test_regions}, {"energies sum to the body's", test_energies_sum},
            {"stiffness as a matrix", test_matrix}, {"after a change of the mesh", test_changed_mesh},
            {"inverted, and refused", test_inverted});
