/* custom: elements of the user's own, from the table through mesh, body, steps and output. A wedge that the library
 * does not have, and its tet4, hex8 and hex20 as tables, which must do what the built-in ones do. */
#include "softbody.h"

#include "check.h"
#include "scene.h"
#include "wedge.h"

/* ---- built-in elements as tables ---- */

typedef struct copied_element {
    sb_element_type type;
    sb_element_table table;
    sb_real nodes[SB_MAX_ELEMENT_NODES][3];
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS];
    sb_real mass_points[SB_MAX_QUADRATURE_POINTS][3], mass_weights[SB_MAX_QUADRATURE_POINTS];
    sb_element_table_face faces[6];
} copied_element;

static void copied_shape(const void *user, const sb_real xi[3], sb_real *shape, sb_real (*gradient)[3])
{
    sb_element_shape(*(const sb_element_type *)user, xi, shape, gradient);
}

static void copied_make(copied_element *copy, sb_element_type type)
{
    sb_element_table *table = &copy->table;
    memset(copy, 0, sizeof *copy);
    copy->type = type;
    table->name = "copy";
    table->node_count = sb_element_node_count(type);
    table->corner_count = sb_element_corner_count(type);
    for (int a = 0; a < table->node_count; a++)
        sb_element_node_point(type, a, copy->nodes[a]);
    table->node_points = (const sb_real(*)[3])copy->nodes;
    table->shape = copied_shape;
    table->user = &copy->type;
    table->point_count = sb_element_quadrature(type, SB_QUADRATURE_STIFFNESS, copy->points, copy->weights);
    table->points = (const sb_real(*)[3])copy->points;
    table->weights = copy->weights;
    table->mass_point_count = sb_element_quadrature(type, SB_QUADRATURE_MASS, copy->mass_points, copy->mass_weights);
    table->mass_points = (const sb_real(*)[3])copy->mass_points;
    table->mass_weights = copy->mass_weights;
    table->face_count = sb_element_face_count(type);
    for (int f = 0; f < table->face_count; f++)
        sb_element_face(type, f, copy->faces[f].nodes, &copy->faces[f].type);
    table->faces = copy->faces;
    CHECK_OK(sb_element_table_check(table, NULL));
}

static sb_material custom_material(int model)
{
    switch (model) {
    case 0: return sb_material_linear(REAL(5e3), REAL(0.3), REAL(1000));
    case 1: return sb_material_corotated(REAL(5e3), REAL(0.3), REAL(1000));
    case 2: return sb_material_corotated_invertible(REAL(5e3), REAL(0.3), REAL(1000));
    case 3: return sb_material_svk(REAL(5e3), REAL(0.3), REAL(1000));
    case 4: return sb_material_neo_hookean(REAL(5e3), REAL(0.3), REAL(1000));
    default: return sb_material_stable_neo_hookean(REAL(5e3), REAL(0.3), REAL(1000));
    }
}
enum { CUSTOM_MODELS = 6 };

/* A held beam under gravity and a traction on its end, five steps; the displacements go to u. */
static void custom_play(const sb_mesh *mesh, sb_mass_kind mass, sb_integrator integrator, int model, sb_vec3 *u)
{
    sb_body_def def = sb_default_body_def();
    sb_vec3 low, high;
    sb_boundary boundary;
    sb_body *body;
    def.mesh = mesh;
    def.material = custom_material(model);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.mass = mass;
    def.integrator = integrator;
    def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-6 : 1e-12);
    def.newton_tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-5 : 1e-11);
    body = scene_body(&def);
    if (!body)
        return;
    scene_fix_plane(body, mesh, 0, 0, SB_XYZ);
    sb_mesh_bounds(mesh, &low, &high);
    CHECK_OK(sb_mesh_boundary(mesh, 0, NULL, &boundary, NULL));
    for (int f = 0; f < boundary.surface.element_count; f++) {
        int corners = sb_element_corner_count(boundary.surface.element_type), at_end = 1;
        const int *face = boundary.surface.elements + f * sb_mesh_element_width(&boundary.surface);
        for (int k = 0; k < corners; k++)
            at_end = at_end && mesh->nodes[face[k]].x > REAL(0.999) * high.x;
        if (at_end)
            CHECK_OK(sb_body_add_traction(body, face, 1, corners, sb_v3(0, 20, 5), NULL));
    }
    for (int s = 0; s < 5; s++)
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    memcpy(u, sb_body_displacements(body), (size_t)mesh->node_count * sizeof(sb_vec3));
    sb_boundary_free(&boundary);
    sb_body_destroy(body);
}

/* The same element built in and by its table: the same motion, for every mass and material. */
static void test_copies(void)
{
    static const sb_element_type types[3] = {SB_TET4, SB_HEX8, SB_HEX20};
    static const sb_mass_kind masses[3] = {SB_MASS_LUMPED, SB_MASS_CONSISTENT, SB_MASS_REDUCED};
    for (int t = 0; t < 3; t++)
        for (int m = 0; m < CUSTOM_MODELS; m++) {
            copied_element copy;
            sb_mesh mesh = scene_box(types[t], 4, 2, 2, sb_v3(REAL(0.1), REAL(0.04), REAL(0.04)), 0.1), custom;
            sb_vec3 *expected = (sb_vec3 *)malloc(2 * sizeof(sb_vec3) * (size_t)mesh.node_count);
            sb_vec3 *found = expected + mesh.node_count;
            copied_make(&copy, types[t]);
            custom = mesh;
            custom.element_type = SB_CUSTOM;
            custom.table = &copy.table;
            CHECK_OK(sb_mesh_validate(&custom, NULL));
            CHECK_NEAR(sb_mesh_volume(&custom), 1.6e-4, 1.6e-4 * scene_tolerance(1e-13, 64));
            custom_play(&mesh, masses[m % 3], m % 2 ? SB_EULER : SB_NEWMARK, m, expected);
            custom_play(&custom, masses[m % 3], m % 2 ? SB_EULER : SB_NEWMARK, m, found);
            CHECK(scene_distance(expected, found, mesh.node_count) <=
                  scene_tolerance(1e-8, 2e4) * scene_distance(expected, mesh.nodes, mesh.node_count));
            CHECK((double)sb_v3_norm(found[mesh.node_count - 1]) > 1e-3);
            free(expected);
            sb_mesh_free(&mesh);
        }
}

/* ---- the wedge as a mesh ---- */

static void test_mesh(void)
{
    sb_element_table table = wedge_table();
    sb_mesh mesh = wedge_box(&table, 3, 2, 2, sb_v3(3, 2, 2), 0.2), copy, reordered;
    sb_mesh_report report;
    sb_boundary boundary;
    sb_index_table neighbours, edges, parts;
    sb_index_lists lists;
    sb_error error;
    int flipped = 7, count = 0, pairs = 0, quads = 0, triangles = 0;
    mesh.regions = (int *)malloc(sizeof(int) * (size_t)mesh.element_count);
    for (int e = 0; e < mesh.element_count; e++)
        mesh.regions[e] = e;
    CHECK_INT(sb_mesh_element_width(&mesh), 6);
    CHECK_OK(sb_mesh_validate(&mesh, &error));
    CHECK_NEAR(sb_mesh_volume(&mesh), 12, scene_tolerance(1e-12, 100));
    CHECK_OK(sb_mesh_check(&mesh, NULL, &report, NULL));
    CHECK_INT(report.bad_count + report.nonmanifold_faces + report.unreferenced_nodes, 0);
    CHECK_INT(report.components, 1);
    CHECK_INT(report.boundary_faces, 2 * 6 * 2 + 2 * 2 * (3 + 2)); /* above and below triangles, around quads */
    CHECK(report.worst_quality > REAL(0.2) && report.worst_quality < 1);
    sb_mesh_report_free(&report);
    CHECK_OK(sb_mesh_boundary(&mesh, 1, NULL, &boundary, NULL));
    CHECK_INT(boundary.surface.element_type, SB_TRI3);
    CHECK_INT(boundary.surface.element_count, 2 * 6 * 2 + 2 * 2 * 2 * (3 + 2));
    CHECK_NEAR(sb_mesh_volume(&boundary.surface), 12, scene_tolerance(1e-12, 100)); /* closed, outward */
    for (int f = 0; f < boundary.surface.element_count; f++) {
        CHECK_INT(boundary.surface.regions[f], boundary.elements[f]);
        *(wedge_faces[boundary.faces[f]].type == SB_QUAD4 ? &quads : &triangles) += 1;
    }
    CHECK_INT(quads, 40);
    CHECK_INT(triangles, 24);
    CHECK_OK(sb_mesh_neighbours(&mesh, NULL, &neighbours, NULL));
    CHECK_INT(neighbours.columns, 5);
    for (int i = 0; i < neighbours.rows * 5; i++)
        pairs += neighbours.items[i] >= 0;
    CHECK_INT(pairs + 44, 5 * mesh.element_count);
    CHECK_OK(sb_mesh_edges(&mesh, NULL, &edges, NULL));
    CHECK_INT(edges.rows, 3 * 9 + 8 * 3 + 12 * 2 + 6 * 3); /* along x, y, z, and diagonals of the layers */
    CHECK_OK(sb_mesh_components(&mesh, NULL, &parts, &count, NULL));
    CHECK_INT(count, 1);
    CHECK_OK(sb_mesh_node_elements(&mesh, NULL, &lists, NULL));
    CHECK_INT(lists.offsets[lists.count], 6 * mesh.element_count);
    CHECK_OK(sb_mesh_copy(&mesh, NULL, &copy, NULL));
    CHECK(copy.table == &table && copy.element_type == SB_CUSTOM);
    CHECK(memcmp(copy.elements, mesh.elements, sizeof(int) * 6 * (size_t)mesh.element_count) == 0);
    reordered = copy;
    CHECK_OK(sb_mesh_reorder(&reordered, NULL, NULL, NULL));
    CHECK_NEAR(sb_mesh_volume(&reordered), 12, scene_tolerance(1e-12, 100));
    CHECK_OK(sb_mesh_orient(&reordered, &flipped, NULL));
    CHECK_INT(flipped, 0);
    CHECK_RESULT(sb_mesh_to_tet10(&mesh, NULL, &copy, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "wedge") != NULL);
    sb_index_table_free(&neighbours);
    sb_index_table_free(&edges);
    sb_index_table_free(&parts);
    sb_index_lists_free(&lists);
    sb_boundary_free(&boundary);
    sb_mesh_free(&copy);
    sb_mesh_free(&mesh);
}

/* Bad meshes and tables are refused by name wherever they come in. */
static void test_refusals(void)
{
    sb_element_table table = wedge_table();
    sb_mesh mesh = wedge_box(&table, 2, 1, 1, sb_v3(2, 1, 1), 0), copy;
    sb_mesh_report report;
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_error error;
    int keep, flipped = 0;
    def.mesh = &mesh;
    def.material = custom_material(1);
    mesh.table = NULL;
    CHECK_INT(sb_mesh_element_width(&mesh), 0);
    CHECK_RESULT(sb_mesh_validate(&mesh, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "no element table") != NULL);
    CHECK_RESULT(sb_mesh_check(&mesh, NULL, &report, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_copy(&mesh, NULL, &copy, NULL), SB_ERROR_ARGUMENT);
    CHECK_INT(sb_mesh_volume(&mesh) == 0 && sb_mesh_element_quality(&mesh, 0) == 0, 1);
    CHECK_RESULT(sb_body_create(&def, &body, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_save_vtk("never.vtk", &mesh, NULL, 0, NULL), SB_ERROR_ARGUMENT);
    mesh.table = &table;
    table.point_count = 5;
    CHECK_RESULT(sb_body_create(&def, &body, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "wedge: the stiffness weights sum to") != NULL);
    table.point_count = 6, table.vtk_type = 0;
    CHECK_RESULT(sb_mesh_save_vtk("never.vtk", &mesh, NULL, 0, &error), SB_ERROR_UNSUPPORTED);
    CHECK(strstr(error.message, "wedge") != NULL);
    CHECK_RESULT(sb_mesh_save_obj("never.obj", &mesh, &error), SB_ERROR_UNSUPPORTED);
    def.single_rotation = 1;
    CHECK_RESULT(sb_body_create(&def, &body, &error), SB_ERROR_ARGUMENT);
    def.single_rotation = 0;
    keep = mesh.elements[7], mesh.elements[7] = 99;
    CHECK_RESULT(sb_body_create(&def, &body, &error), SB_ERROR_INDEX);
    CHECK_INT(error.element, 1);
    mesh.elements[7] = mesh.elements[6];
    CHECK_RESULT(sb_body_create(&def, &body, &error), SB_ERROR_MESH);
    mesh.elements[7] = keep;
    for (int a = 0; a < 3; a++) { /* upside down: inverted, and left so */
        keep = mesh.elements[12 + a], mesh.elements[12 + a] = mesh.elements[15 + a], mesh.elements[15 + a] = keep;
    }
    CHECK_RESULT(sb_mesh_validate(&mesh, &error), SB_ERROR_MESH);
    CHECK_INT(error.element, 2);
    CHECK(strstr(error.message, "inverted") != NULL);
    CHECK_OK(sb_mesh_orient(&mesh, &flipped, NULL));
    CHECK_INT(flipped, 0);
    CHECK_RESULT(sb_body_create(&def, &body, &error), SB_ERROR_MESH);
    CHECK(body == NULL);
    sb_mesh_free(&mesh);
}

/* ---- the wedge as a body ---- */

/* Boundary on an affine motion, shaken interior nodes must follow: for every material. */
static void test_patch(void)
{
    for (int m = 0; m < CUSTOM_MODELS; m++) {
        sb_element_table table = wedge_table();
        sb_mesh mesh = wedge_box(&table, 3, 3, 3, sb_v3(1, 1, 1), 0.2);
        sb_body_def def = sb_default_body_def();
        sb_static_options options = sb_default_static_options();
        sb_vec3 *expected = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)mesh.node_count);
        sb_body *body;
        def.mesh = &mesh;
        def.material = custom_material(m);
        body = scene_body(&def);
        CHECK_INT(sb_body_point_count(body), 6);
        scene_fix_boundary(body, &mesh);
        for (int i = 0; i < mesh.node_count; i++) {
            sb_vec3 x = mesh.nodes[i];
            expected[i] = sb_v3(REAL(0.1) * x.x + REAL(0.04) * x.y, REAL(-0.05) * x.y + REAL(0.06) * x.z,
                                REAL(0.05) * x.x + REAL(0.07) * x.z - REAL(0.02));
            if (sb_body_supports(body)[i])
                CHECK_OK(sb_body_prescribe(body, &i, 1, SB_XYZ, &expected[i], 1));
        }
        options.tolerance = REAL(1e-13);
        CHECK_OK(sb_body_solve_static(body, &options, NULL));
        CHECK_NEAR(scene_distance(sb_body_displacements(body), expected, mesh.node_count), 0,
                   scene_tolerance(1e-12, 100));
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(expected);
    }
}

/* Gravity and traction balance the reactions; the mass is right; a turn costs nothing; the set-up check works. */
static void test_body(void)
{
    sb_element_table table = wedge_table();
    sb_mesh mesh = wedge_box(&table, 4, 2, 2, sb_v3(REAL(0.2), REAL(0.1), REAL(0.1)), 0.1);
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_check_report report;
    sb_energy energy;
    sb_error error;
    sb_vec3 sum, *u = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)mesh.node_count);
    sb_body *body;
    /* at x = 0.2 the last hexahedron has the corners 4 9 14 and, a layer above, 19 24 29 */
    static const int quads[4] = {4, 9, 24, 19}, triangles[3] = {30, 31, 35}, none[3] = {30, 31, 36};
    def.mesh = &mesh;
    def.material = custom_material(4);
    def.gravity = sb_v3(0, 0, REAL(-2));
    body = scene_body(&def);
    CHECK_NEAR(sb_body_mass(body), 2, scene_tolerance(1e-12, 100));
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_add_traction(body, quads, 1, 4, sb_v3(50, 0, 0), &error));
    CHECK_OK(sb_body_add_traction(body, triangles, 1, 3, sb_v3(0, 80, 0), &error));
    CHECK_RESULT(sb_body_add_traction(body, none, 1, 3, sb_v3(0, 80, 0), &error), SB_ERROR_ARGUMENT);
    options.tolerance = REAL(1e-10);
    CHECK_OK(sb_body_solve_static(body, &options, NULL));
    sum = scene_sum(sb_body_external_forces(body), mesh.node_count);
    CHECK_NEAR(sum.x, 50 * 0.05 * 0.05, scene_tolerance(1e-12, 100));
    CHECK_NEAR(sum.y, 80 * 0.05 * 0.05 / 2, scene_tolerance(1e-12, 100));
    CHECK_NEAR(sum.z, -2 * 2, scene_tolerance(1e-12, 100));
    sum = sb_v3_add(sum, scene_sum(sb_body_reactions(body), mesh.node_count));
    CHECK_NEAR(sb_v3_norm(sum), 0, scene_tolerance(1e-8, 3000));
    CHECK_OK(sb_body_check(body, &report));
    CHECK_INT(report.warnings, 0);
    for (int i = 0; i < mesh.node_count; i++)
        u[i] = sb_v3(-2 * mesh.nodes[i].x, -2 * mesh.nodes[i].y, REAL(0.3)); /* half a turn about z */
    CHECK_OK(sb_body_set_displacements(body, u));
    CHECK_OK(sb_body_energy(body, &energy));
    CHECK_NEAR(energy.elastic, 0, 5e3 * 0.002 * 20 * (double)SB_EPSILON);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(u);
}

/* The body keeps the table, not the mesh; the same bits for any number of threads. */
static void test_threads(void)
{
    sb_element_table table = wedge_table();
    unsigned long long expected = 0;
    for (int workers = 1; workers <= 7; workers += 3) {
        sb_mesh mesh = wedge_box(&table, 12, 3, 3, sb_v3(REAL(0.2), REAL(0.05), REAL(0.05)), 0.1);
        sb_body_def def = sb_default_body_def();
        size_t bytes = (size_t)mesh.node_count * sizeof(sb_vec3);
        unsigned long long hash;
        sb_body *body;
        def.mesh = &mesh;
        def.material = custom_material(1);
        def.gravity = sb_v3(0, 0, REAL(-9.81));
        def.jobs = scene_jobs(&workers);
        body = scene_body(&def);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        sb_mesh_free(&mesh);
        for (int s = 0; s < 10; s++)
            CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        hash = scene_hash(sb_body_displacements(body), bytes);
        CHECK(workers == 1 || hash == expected);
        expected = hash;
        sb_body_destroy(body);
    }
}

/* Dragged about wildly it neither fails nor stays out of shape. */
static void test_violence(void)
{
    sb_element_table table = wedge_table();
    sb_mesh mesh = wedge_box(&table, 3, 2, 2, sb_v3(REAL(0.15), REAL(0.1), REAL(0.1)), 0.1);
    sb_body_def def = sb_default_body_def();
    unsigned long long seed = 5;
    int tool = mesh.node_count - 1;
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_corotated(REAL(1e4), REAL(0.4), REAL(1000));
    def.damping_stiffness = REAL(0.01);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    for (int s = 0; s < 600; s++) {
        sb_vec3 at = sb_v3(REAL(check_random_in(&seed, -0.4, 0.4)), REAL(check_random_in(&seed, -0.4, 0.4)),
                           REAL(check_random_in(&seed, -0.4, 0.4)));
        if (s % 20 == 0) {
            CHECK_OK(sb_body_release_nodes(body, &tool, 1, SB_XYZ));
            while (sb_body_supports(body)[tool = (int)(check_random(&seed) * mesh.node_count)])
                continue;
        }
        CHECK_OK(sb_body_prescribe(body, &tool, 1, SB_XYZ, &at, 1));
        CHECK_OK(sb_body_step(body, REAL(1.0 / 60), NULL));
    }
    CHECK_OK(sb_body_release_nodes(body, &tool, 1, SB_XYZ));
    CHECK_OK(sb_body_set_solver(body, REAL(1e-4), 500));
    for (int s = 0; s < 600; s++)
        CHECK_OK(sb_body_step(body, REAL(1.0 / 60), NULL));
    CHECK_NEAR(scene_distance(sb_body_positions(body), mesh.nodes, mesh.node_count), 0, 1e-4);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* ---- output, memory ---- */

static void test_output(void)
{
    sb_element_table table = wedge_table();
    sb_mesh mesh = wedge_box(&table, 2, 1, 1, sb_v3(2, 1, 1), 0);
    const char *path = "custom_wedge.vtk.tmp";
    char text[4096];
    size_t size;
    FILE *file;
    CHECK_OK(sb_mesh_save_vtk(path, &mesh, NULL, 0, NULL));
    file = fopen(path, "rb");
    if (CHECK(file != NULL)) {
        size = fread(text, 1, sizeof text - 1, file);
        text[size] = 0;
        fclose(file);
        CHECK(strstr(text, "CELLS 4 28\n6 0 1 3 6 7 9\n") != NULL);
        CHECK(strstr(text, "CELL_TYPES 4\n13\n13\n13\n13\n") != NULL);
    }
    remove(path);
    sb_mesh_free(&mesh);
}

/* Every allocation fails in turn: named, nothing leaked. */
static void test_memory(void)
{
    sb_element_table table = wedge_table();
    sb_mesh mesh = wedge_box(&table, 2, 1, 1, sb_v3(2, 1, 1), 0), hex = scene_box(SB_HEX8, 2, 1, 1, sb_v3(2, 1, 1), 0);
    for (int which = 0; which < 4; which++) {
        sb_result result = SB_ERROR_MEMORY;
        for (int fail = 1; result == SB_ERROR_MEMORY && fail < 200; fail++) {
            scene_memory memory = {0, 0, 0, 0};
            sb_allocator allocator = scene_allocator(&memory);
            sb_body_def def = sb_default_body_def();
            sb_body *body = NULL;
            sb_boundary boundary;
            sb_mesh made;
            sb_error error;
            memory.fail_at = fail;
            memset(&made, 0, sizeof made);
            memset(&boundary, 0, sizeof boundary);
            def.mesh = &mesh;
            def.material = custom_material(1);
            def.allocator = allocator;
            switch (which) {
            case 0: result = sb_body_create(&def, &body, &error); break;
            case 1: result = sb_mesh_boundary(&mesh, 1, &allocator, &boundary, &error); break;
            case 2: result = sb_mesh_to_hex20(&hex, &allocator, &made, &error); break;
            default: result = sb_mesh_to_hex27(&hex, &allocator, &made, &error); break;
            }
            if (result != SB_OK)
                CHECK(!body && !boundary.elements && !made.nodes);
            CHECK(result == SB_ERROR_MEMORY || memory.calls < fail);
            sb_body_destroy(body);
            sb_boundary_free(&boundary);
            sb_mesh_free(&made);
            CHECK_INT(memory.live, 0);
        }
        CHECK_OK(result);
    }
    sb_mesh_free(&hex);
    sb_mesh_free(&mesh);
}

/* Two meshes of one custom element become one, with its table; those of different elements do not. */
static void test_append(void)
{
    sb_element_table table = wedge_table(), other = wedge_table();
    sb_vec3 size = sb_v3(1, 1, 1);
    sb_mesh mesh = wedge_box(&table, 2, 1, 1, size, 0), second = wedge_box(&table, 1, 1, 1, size, 0);
    int nodes = mesh.node_count, elements = mesh.element_count;
    sb_error error;
    for (int i = 0; i < second.node_count; i++)
        second.nodes[i].x += 2;
    CHECK_OK(sb_mesh_append(&mesh, &second, &error));
    CHECK(mesh.table == &table && mesh.node_count == nodes + second.node_count);
    CHECK_INT(mesh.elements[6 * elements + 5], nodes + second.elements[5]);
    CHECK_OK(sb_mesh_validate(&mesh, &error));
    CHECK_NEAR(sb_mesh_volume(&mesh), 2, scene_tolerance(1e-12, 20));
    second.table = &other;
    CHECK_RESULT(sb_mesh_append(&mesh, &second, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "custom") != NULL);
    sb_mesh_free(&mesh);
    sb_mesh_free(&second);
}

CHECK_SUITE(custom, {"append", test_append}, {"built-in elements as tables", test_copies},
            {"mesh of wedges", test_mesh}, {"refusals", test_refusals}, {"patch test", test_patch},
            {"balances and readings", test_body}, {"same bits for any threads", test_threads},
            {"violence", test_violence}, {"VTK output", test_output}, {"every allocation failing", test_memory});
