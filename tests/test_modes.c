/* Natural frequencies: an industrial program's and closed forms, multiple and rigid modes, what shapes must satisfy,
 * scale, a body that is left alone, refusals and failing memory. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

static const sb_element_type element_types[] = {SB_TET4, SB_TET10, SB_HEX8};
enum { ELEMENT_TYPES = 3, MOST = 30 };

static sb_body *elastic_body(const sb_mesh *mesh, sb_material material)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = material;
    return scene_body(&def);
}

static int find(sb_body *body, int count, const sb_modes_options *options, sb_real *f, sb_vec3 *shapes)
{
    sb_modes_info info;
    sb_error error;
    sb_result result = sb_body_modes(body, count, options, f, shapes, &info, &error);
    if (!CHECK_OK(result)) {
        printf("%s\n", error.message);
        return 0;
    }
    CHECK(info.solves > 0 && (double)info.residual <= scene_tolerance(1e-8, 1e4));
    for (int i = 0; i < count; i++)
        CHECK(sb_is_finite(f[i]) && f[i] >= 0);
    return 1;
}

/* ---- references ---- */

/* Compares with frequencies.txt, column f_exact_mass, printed with 7 digits. Rigid modes: 0. */
static void compare_reference(const char *name)
{
    char path[512], relative[256], line[512];
    int clamped = strstr(name, "cantilever") != NULL, count = 0;
    double expected[MOST], worst = 0, rigid = 0;
    sb_real f[MOST];
    sb_mesh mesh;
    sb_error error;
    sb_body *body;
    FILE *file;
    memset(&mesh, 0, sizeof mesh);
    snprintf(relative, sizeof relative, "reference/%s/mesh.vtk", name);
    if (!check_shared_path(path, sizeof path, relative)) {
        CHECK_SKIP("no ../shared/reference");
        return;
    }
    if (sb_mesh_load(&mesh, path, NULL, &error) != SB_OK) {
        CHECK_RESULT(error.result, SB_ERROR_UNSUPPORTED);
        CHECK_SKIP("elements that are not read");
        return;
    }
    snprintf(relative, sizeof relative, "reference/%s/frequencies.txt", name);
    if (!CHECK(check_shared_path(path, sizeof path, relative)))
        return;
    file = fopen(path, "r");
    while (file && count < MOST && fgets(line, sizeof line, file))
        count += sscanf(line, "%*d %*f %*f %lf", expected + count) == 1;
    if (file)
        fclose(file);
    body = elastic_body(&mesh, sb_material_linear(REAL(1e5), REAL(0.3), 1000));
    if (body && CHECK(count > 6)) {
        if (clamped)
            scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        if (find(body, count, NULL, f, NULL))
            for (int i = 0; i < count; i++) {
                if (i < 6 && !clamped)
                    rigid = fmax(rigid, (double)f[i] / expected[6]);
                else
                    worst = fmax(worst, fabs((double)f[i] / expected[i] - 1));
            }
        printf("  %-24s %d modes, off by %.1e at most, rigid ones by %.1e of the first elastic\n", name, count, worst,
               rigid);
        CHECK_NEAR(worst, 0, SB_REAL_IS_FLOAT ? 2e-3 : 1e-6);
        CHECK_NEAR(rigid, 0, SB_REAL_IS_FLOAT ? 0.1 : 1e-5);
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

static void test_references(void)
{
    compare_reference("modal_cantilever_tet4");
    compare_reference("modal_cantilever_tet10");
    compare_reference("modal_cantilever_hex8");
    compare_reference("modal_cantilever_hex20");
    compare_reference("modal_free_tet4");
    compare_reference("modal_free_tet10");
    compare_reference("modal_free_hex8");
    compare_reference("modal_free_hex20");
}

/* ---- closed forms ---- */

/* Longitudinal waves of a bar with nu = 0, held at one end, guided along x: f = (2 k - 1)/4 sqrt(E/rho)/L. */
static void test_bar(void)
{
    sb_mesh mesh = scene_box(SB_TET10, 12, 1, 1, sb_v3(1, REAL(0.1), REAL(0.1)), 0);
    sb_body *body = elastic_body(&mesh, sb_material_linear(REAL(1e5), 0, 1000));
    sb_real f[3];
    for (int i = 0; i < mesh.node_count; i++)
        CHECK_OK(sb_body_fix_nodes(body, &i, 1, mesh.nodes[i].x == 0 ? SB_XYZ : SB_Y | SB_Z));
    if (find(body, 3, NULL, f, NULL))
        for (int k = 0; k < 3; k++)
            CHECK_NEAR(f[k], (2 * k + 1) / 4.0 * 10, 2e-3);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* A slender square cantilever: bending in pairs, near Euler and Bernoulli's 1.8751^2/(2 pi) sqrt(EI/(rho A L^4)), a
 * little below for shear. */
static void test_beam(void)
{
    sb_mesh mesh = scene_box(SB_HEX8, 120, 2, 2, sb_v3(1, REAL(0.05), REAL(0.05)), 0);
    sb_body *body = elastic_body(&mesh, sb_material_linear(REAL(1e6), 0, 1000));
    double bending = sqrt(1e6 * 0.05 * 0.05 / (12 * 1000)) / 6.283185307179586, first = 1.875104 * 1.875104 * bending,
           second = 4.694091 * 4.694091 * bending;
    sb_real f[4];
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    if (find(body, 4, NULL, f, NULL)) {
        printf("  slender beam: %.5f %.5f, Euler and Bernoulli %.5f; %.4f %.4f, %.4f Hz\n", (double)f[0], (double)f[1],
               first, (double)f[2], (double)f[3], second);
        /* float: rounding in K x is some eps (L/h)^4 of the lowest lambda */
        CHECK_NEAR((double)f[0] / first, 1, SB_REAL_IS_FLOAT ? 0.1 : 0.02);
        CHECK_NEAR((double)f[2] / second, 1, 0.03);
        CHECK_NEAR((double)f[1] / (double)f[0], 1, SB_REAL_IS_FLOAT ? 0.1 : 1e-9);
        CHECK_NEAR((double)f[3] / (double)f[2], 1, SB_REAL_IS_FLOAT ? 1e-2 : 1e-9);
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* A tet4 on its own: six rigid modes and six elastic ones, all of them. Two of them: everything twice. */
static void test_every_mode(void)
{
    static const sb_vec3 nodes[8] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1},
                                     {5, 0, 0}, {6, 0, 0}, {5, 1, 0}, {5, 0, 1}};
    static const int elements[8] = {0, 1, 2, 3, 4, 5, 6, 7};
    sb_real one[12], two[24];
    for (int k = 1; k <= 2; k++) {
        sb_mesh mesh;
        sb_body *body;
        memset(&mesh, 0, sizeof mesh);
        mesh.element_type = SB_TET4;
        mesh.node_count = 4 * k;
        mesh.element_count = k;
        mesh.nodes = (sb_vec3 *)malloc(sizeof nodes);
        mesh.elements = (int *)malloc(sizeof elements);
        memcpy(mesh.nodes, nodes, sizeof nodes);
        memcpy(mesh.elements, elements, sizeof elements);
        body = elastic_body(&mesh, sb_material_linear(1000, REAL(0.3), 1000));
        find(body, 12 * k, NULL, k == 1 ? one : two, NULL);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
    for (int i = 0; i < 24; i++)
        if (i < 12)
            CHECK_NEAR(two[i], 0, (double)two[12] * scene_tolerance(1e-6, 1e5));
        else
            CHECK_NEAR((double)two[i] / (double)one[i / 2], 1, scene_tolerance(1e-9, 1e3));
    CHECK(one[6] > 0 && one[5] < REAL(0.02) * one[6]);
}

/* ---- what shapes must satisfy ---- */

/* x^T M y by the library's own consistent mass: kinetic energy of x + y and of x - y. */
static double mass_product(sb_body *body, const sb_vec3 *x, const sb_vec3 *y, int n)
{
    sb_vec3 *v = (sb_vec3 *)malloc((size_t)n * sizeof(sb_vec3));
    sb_energy plus, minus;
    for (int i = 0; i < n; i++)
        v[i] = sb_v3_add(x[i], y[i]);
    CHECK_OK(sb_body_set_velocities(body, v));
    CHECK_OK(sb_body_energy(body, &plus));
    for (int i = 0; i < n; i++)
        v[i] = sb_v3_sub(x[i], y[i]);
    CHECK_OK(sb_body_set_velocities(body, v));
    CHECK_OK(sb_body_energy(body, &minus));
    free(v);
    return ((double)plus.kinetic - (double)minus.kinetic) / 2;
}

/* Springs and a row at rest, and a node between two others. */
static void hold_more(sb_body *body, const sb_mesh *mesh)
{
    const int nodes[2] = {mesh->node_count - 1, mesh->node_count / 2}, starts[2] = {0, 2};
    const sb_real k = 40, weights[2] = {REAL(0.5), REAL(0.5)};
    sb_vec3 points[2], middle;
    sb_constraint_term terms[3];
    sb_mapping mapping;
    int id = 0;
    for (int i = 0; i < 2; i++)
        points[i] = mesh->nodes[nodes[i]];
    middle = sb_v3_scale(REAL(0.5), sb_v3_add(points[0], points[1]));
    mapping.row_count = 1;
    mapping.row_start = starts;
    mapping.nodes = nodes;
    mapping.weights = weights;
    CHECK_OK(sb_body_add_springs(body, nodes, 2, &k, 1, points, &id, NULL));
    CHECK_OK(sb_body_add_mapping(body, &mapping, &k, 1, &middle, &id, NULL));
    for (int t = 0; t < 3; t++) {
        terms[t].node = mesh->node_count - 2 - t;
        terms[t].axis = 2;
        terms[t].coefficient = t ? REAL(-0.5) : 1;
    }
    CHECK_OK(sb_body_add_constraint(body, terms, 3, 0, NULL, NULL));
}

/* Shapes are orthonormal in M, 0 at supports, and their elastic energy is omega^2/2; nearly incompressible too. With
 * springs and constraints all the same. */
static void shapes_hold(sb_element_type type, sb_integration integration, double poisson, int more)
{
    sb_mesh mesh = scene_box(type, more ? 3 : 5, 2, 2, sb_v3(REAL(0.2), REAL(0.08), REAL(0.08)), 0.2);
    sb_body_def def = sb_default_body_def();
    int n = mesh.node_count;
    enum { COUNT = 6 };
    sb_vec3 *shapes = (sb_vec3 *)malloc(COUNT * (size_t)n * sizeof(sb_vec3));
    sb_real f[COUNT];
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_linear(REAL(5e3), REAL(poisson), REAL(1050));
    def.mass = SB_MASS_CONSISTENT;
    def.integration = integration;
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    if (more)
        hold_more(body, &mesh);
    if (find(body, COUNT, NULL, f, shapes))
        for (int i = 0; i < COUNT; i++) {
            const sb_vec3 *x = shapes + (size_t)i * (size_t)n;
            double omega = 6.283185307179586 * (double)f[i];
            sb_energy energy;
            for (int j = 0; j <= i; j++)
                CHECK_NEAR(mass_product(body, x, shapes + (size_t)j * (size_t)n, n), i == j,
                           scene_tolerance(1e-10, 100));
            for (int k = 0; k < n; k++)
                if (sb_body_supports(body)[k])
                    CHECK(sb_v3_norm(x[k]) == 0);
            CHECK_OK(sb_body_set_displacements(body, x));
            CHECK_OK(sb_body_energy(body, &energy));
            CHECK_NEAR(((double)energy.elastic + (double)energy.springs) / (0.5 * omega * omega), 1,
                       scene_tolerance(1e-9, 1e5));
            if (more) {
                sb_vec3 sum = sb_v3_add(x[n - 3], x[n - 4]);
                CHECK_NEAR(x[n - 2].z, 0.5 * (double)sum.z, scene_tolerance(1e-14, 4) * omega);
                CHECK(energy.springs > 0);
            }
        }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(shapes);
}

static void test_shapes(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        shapes_hold(element_types[t], SB_INTEGRATION_AUTO, 0.3, 0);
        if (!SB_REAL_IS_FLOAT)
            shapes_hold(element_types[t], SB_INTEGRATION_AUTO, 0.499, 0);
        shapes_hold(element_types[t], SB_INTEGRATION_AUTO, 0.3, 1);
    }
    shapes_hold(SB_HEX8, SB_INTEGRATION_BBAR, 0.4, 0);
    if (!SB_REAL_IS_FLOAT)
        shapes_hold(SB_HEX8, SB_INTEGRATION_BBAR, 0.499, 1);
    shapes_hold(SB_HEX20, SB_INTEGRATION_AUTO, 0.3, 1);
    shapes_hold(SB_HEX27, SB_INTEGRATION_AUTO, 0.3, 1);
}

/* A shape let go swings with its frequency: one period of Newmark's rule later it is back. */
static void test_swing(void)
{
    sb_mesh mesh = scene_box(SB_TET10, 4, 1, 1, sb_v3(REAL(0.2), REAL(0.05), REAL(0.05)), 0);
    sb_body_def def = sb_default_body_def();
    int n = mesh.node_count, steps = 200;
    sb_vec3 *shapes = (sb_vec3 *)malloc(3 * (size_t)n * sizeof(sb_vec3)), *x = shapes + 2 * n;
    sb_real f[3];
    sb_body *body;
    def.mesh = &mesh;
    def.material = sb_material_linear(REAL(5e3), REAL(0.4), REAL(1050));
    def.mass = SB_MASS_CONSISTENT;
    def.integrator = SB_NEWMARK;
    def.tolerance = REAL(SB_REAL_IS_FLOAT ? 1e-6 : 1e-10);
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    if (find(body, 3, NULL, f, shapes)) {
        double size = 0;
        for (int i = 0; i < n; i++)
            size = fmax(size, (double)sb_v3_norm(x[i]));
        CHECK_OK(sb_body_set_displacements(body, x));
        for (int s = 0; s < steps; s++)
            CHECK_OK(sb_body_step(body, 1 / (f[2] * REAL(steps)), NULL));
        CHECK_NEAR(scene_distance(sb_body_displacements(body), x, n) / size, 0, 1e-3); /* (pi^3/3)/200^2 and a little */
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(shapes);
}

/* ---- what holds a body besides supports ---- */

/* A hard cube on springs, on rows, or on springs at a node that the others follow: sqrt(k/m). */
static void test_springs(void)
{
    for (int how = 0; how < 3; how++) {
        sb_mesh mesh = scene_box(SB_HEX8, 1, 1, 1, sb_v3(1, 1, 1), 0);
        sb_body *body = elastic_body(&mesh, sb_material_linear(REAL(1e8), REAL(0.3), 1000));
        const int starts[2] = {0, 8}, nodes[8] = {0, 1, 2, 3, 4, 5, 6, 7};
        sb_real weights[8], k = how ? 4000 : 500, f[6];
        sb_vec3 points[8];
        sb_mapping mapping;
        int id = 0, rigid = 0;
        for (int i = 0; i < 8; i++) {
            weights[i] = REAL(0.125);
            points[i] = how == 1 ? sb_v3(REAL(0.5), REAL(0.5), REAL(0.5)) : mesh.nodes[i];
        }
        mapping.row_count = 1;
        mapping.row_start = starts;
        mapping.nodes = nodes;
        mapping.weights = weights;
        for (int i = 1; i < 8 && how == 2; i++)
            for (int axis = 0; axis < 3; axis++) {
                sb_constraint_term link[2];
                for (int t = 0; t < 2; t++) {
                    link[t].node = t ? 0 : i;
                    link[t].axis = axis;
                    link[t].coefficient = t ? -1 : 1;
                }
                CHECK_OK(sb_body_add_constraint(body, link, 2, 0, NULL, NULL));
            }
        if (how == 1)
            CHECK_OK(sb_body_add_mapping(body, &mapping, &k, 1, points, &id, NULL));
        else
            CHECK_OK(sb_body_add_springs(body, nodes, how ? 1 : 8, &k, 1, points, &id, NULL));
        if (find(body, how == 2 ? 3 : 6, NULL, f, NULL))
            for (int i = 0; i < (how == 2 ? 3 : 6);
                 i++) { /* 0, as often as it can turn about a row; else more: it rocks */
                rigid += f[i] < REAL(0.05);
                if (i == (how == 1 ? 3 : 0))
                    CHECK_NEAR((double)f[i] * 6.283185307179586, 2, SB_REAL_IS_FLOAT ? 1e-2 : 1e-4);
            }
        CHECK_INT(rigid, how == 1 ? 3 : 0);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* Two blocks with the same grid, tied, are one. */
static void test_tied_as_merged(void)
{
    for (int t = 0; t < ELEMENT_TYPES; t++) {
        sb_mesh whole = scene_box(element_types[t], 4, 1, 1, sb_v3(REAL(0.2), REAL(0.05), REAL(0.05)), 0);
        sb_mesh mesh = scene_box(element_types[t], 2, 1, 1, sb_v3(REAL(0.1), REAL(0.05), REAL(0.05)), 0), second;
        int split = mesh.node_count, slave_count = 0, face_count = 0, slaves[64], faces[64], corners;
        sb_real merged[8], tied[8];
        sb_boundary boundary;
        sb_body *body;
        CHECK_OK(sb_mesh_copy(&mesh, NULL, &second, NULL));
        for (int i = 0; i < second.node_count; i++)
            second.nodes[i].x += REAL(0.1);
        CHECK_OK(sb_mesh_append(&mesh, &second, NULL));
        CHECK_OK(sb_mesh_boundary(&mesh, 0, NULL, &boundary, NULL));
        corners = sb_element_corner_count(boundary.surface.element_type);
        for (int f = 0; f < boundary.surface.element_count; f++) {
            const int *face = boundary.surface.elements + f * sb_element_node_count(boundary.surface.element_type);
            int on = 1;
            for (int k = 0; k < corners; k++)
                on = on && face[k] < split && fabs((double)mesh.nodes[face[k]].x - 0.1) < 1e-6;
            for (int k = 0; k < corners && on; k++)
                faces[corners * face_count + k] = face[k];
            face_count += on;
        }
        for (int i = split; i < mesh.node_count; i++)
            if (fabs((double)mesh.nodes[i].x - 0.1) < 1e-6)
                slaves[slave_count++] = i;
        body = elastic_body(&whole, sb_material_linear(REAL(5e3), REAL(0.3), 1000));
        scene_fix_plane(body, &whole, 0, 0, SB_XYZ);
        find(body, 8, NULL, merged, NULL);
        sb_body_destroy(body);
        body = elastic_body(&mesh, sb_material_linear(REAL(5e3), REAL(0.3), 1000));
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        CHECK_OK(sb_body_tie_faces(body, faces, face_count, corners, slaves, slave_count, -1, SB_TIE_ALL, NULL, NULL));
        if (find(body, 8, NULL, tied, NULL))
            for (int i = 0; i < 8; i++)
                CHECK_NEAR((double)tied[i] / (double)merged[i], 1, SB_REAL_IS_FLOAT ? 1e-3 : 1e-9);
        sb_body_destroy(body);
        sb_boundary_free(&boundary);
        sb_mesh_free(&second);
        sb_mesh_free(&mesh);
        sb_mesh_free(&whole);
    }
}

/* Prony terms: the frequencies of the instantaneous material, whatever is remembered. Pressure counts at the present
 * shape only. */
static void test_prony_and_pressure(void)
{
    const sb_real g = REAL(0.5), tau = REAL(0.1);
    sb_mesh mesh = scene_box(SB_HEX8, 4, 1, 1, sb_v3(REAL(0.2), REAL(0.05), REAL(0.05)), 0);
    sb_material material = sb_material_neo_hookean(REAL(5e3), REAL(0.3), 1000);
    sb_modes_options options = sb_default_modes_options();
    sb_real elastic[3], viscous[3], later[3], present[3];
    sb_body *body;
    int id = 0;
    for (int k = 0; k < 2; k++) {
        body = elastic_body(&mesh, k ? sb_material_with_prony(material, &g, &tau, 1) : material);
        scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
        find(body, 3, NULL, k ? viscous : elastic, NULL);
        if (k) {
            CHECK_OK(sb_body_set_gravity(body, sb_v3(1, 0, 0)));
            for (int s = 0; s < 20; s++)
                CHECK_OK(sb_body_step(body, REAL(0.05), NULL));
            find(body, 3, NULL, later, NULL);
            options.at_present = 1;
            find(body, 3, &options, present, NULL);
        } else {
            sb_boundary boundary;
            CHECK_OK(sb_mesh_boundary(&mesh, 0, NULL, &boundary, NULL));
            CHECK_OK(sb_body_add_pressure(body, boundary.surface.elements + 4 * (boundary.surface.element_count - 1), 1,
                                          4, 100, &id, NULL));
            sb_boundary_free(&boundary);
            find(body, 3, NULL, later, NULL);
            CHECK(memcmp(later, elastic, sizeof later) == 0);
            options.at_present = 1;
            find(body, 3, &options, present, NULL);
            CHECK(memcmp(present, elastic, sizeof present) != 0);
            CHECK_NEAR((double)present[0] / (double)elastic[0], 1, 0.3);
            options.at_present = 0;
        }
        sb_body_destroy(body);
    }
    for (int i = 0; i < 3; i++) {
        CHECK_NEAR((double)viscous[i] / (double)elastic[i], 1, scene_tolerance(1e-9, 1e4));
        CHECK_NEAR((double)later[i] / (double)elastic[i], 1, scene_tolerance(1e-9, 1e4));
        CHECK(i > 0 || present[i] > elastic[i]); /* it hangs, which hinders bending */
    }
    sb_mesh_free(&mesh);
}

/* ---- options ---- */

/* The mass is the caller's choice, not the body's; for bars lumping lowers, and consistency raises, frequencies. */
static void test_mass_kinds(void)
{
    sb_mesh mesh = scene_box(SB_HEX8, 10, 1, 1, sb_v3(1, REAL(0.1), REAL(0.1)), 0);
    sb_body_def def = sb_default_body_def();
    sb_modes_options options = sb_default_modes_options();
    sb_real lumped = 0, consistent = 0, again = 0;
    for (int k = 0; k < 2; k++) {
        sb_body *body;
        def.mesh = &mesh;
        def.material = sb_material_linear(REAL(1e5), 0, 1000);
        def.mass = k ? SB_MASS_CONSISTENT : SB_MASS_LUMPED;
        body = scene_body(&def);
        for (int i = 0; i < mesh.node_count; i++)
            CHECK_OK(sb_body_fix_nodes(body, &i, 1, mesh.nodes[i].x == 0 ? SB_XYZ : SB_Y | SB_Z));
        options.mass = SB_MASS_LUMPED;
        find(body, 1, &options, &lumped, NULL);
        options.mass = SB_MASS_CONSISTENT;
        find(body, 1, &options, k ? &again : &consistent, NULL);
        sb_body_destroy(body);
    }
    CHECK(again == consistent);
    CHECK_NEAR(consistent, 2.5 * (1 + 0.05 * 0.05 * 2.4674 / 6), 1e-3); /* (k h)^2/24 with k h = pi/20 */
    CHECK(lumped < REAL(2.5) && consistent > REAL(2.5));
    sb_mesh_free(&mesh);
}

/* Stretched, a bar bends at higher frequencies; turned as a whole, at the same ones; compressed too far it buckles. */
static void test_present_shape(void)
{
    sb_mesh mesh = scene_box(SB_HEX8, 12, 2, 2, sb_v3(1, REAL(0.1), REAL(0.1)), 0);
    sb_body *body = elastic_body(&mesh, sb_material_svk(REAL(1e5), 0, 1000));
    sb_modes_options options = sb_default_modes_options();
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof(sb_vec3));
    sb_real rest[2], present[2], untouched = -3;
    sb_error error;
    options.at_present = 1;
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    find(body, 2, NULL, rest, NULL);
    for (int i = 0; i < mesh.node_count; i++) /* a quarter turn about z, through (0, 0) */
        u[i] = sb_v3(-mesh.nodes[i].y - mesh.nodes[i].x, mesh.nodes[i].x - mesh.nodes[i].y, 0);
    CHECK_OK(sb_body_set_displacements(body, u));
    find(body, 2, &options, present, NULL);
    CHECK_NEAR((double)present[0] / (double)rest[0], 1, SB_REAL_IS_FLOAT ? 2e-2 : 1e-7);
    scene_fix_plane(body, &mesh, 0, 1, SB_XYZ);
    for (int k = -1; k <= 1; k += 2) {
        for (int i = 0; i < mesh.node_count; i++)
            u[i] = sb_v3(REAL(0.1 * k) * mesh.nodes[i].x, 0, 0);
        CHECK_OK(sb_body_set_displacements(body, u));
        if (k > 0) {
            find(body, 2, NULL, rest, NULL);
            find(body, 2, &options, present, NULL);
            CHECK(present[0] > REAL(1.2) * rest[0]);
        } else {
            CHECK_RESULT(sb_body_modes(body, 1, &options, &untouched, NULL, NULL, &error), SB_ERROR_INDEFINITE);
            CHECK(untouched == -3 && error.message[0]);
        }
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(u);
}

/* ---- scale, other bodies' state ---- */

static void test_scale(void)
{
    double reference[8];
    for (int k = 0; k < 3; k++) {
        double scale = k == 0 ? 1 : k == 1 ? 1e-3 : 1e3;
        sb_mesh mesh =
            scene_box(SB_TET10, 4, 2, 2, sb_v3(REAL(0.1 * scale), REAL(0.04 * scale), REAL(0.04 * scale)), 0.1);
        sb_body *body = elastic_body(&mesh, sb_material_corotated(REAL(2e3 * scale), REAL(0.4), 1000));
        sb_real f[8];
        if (find(body, 8, NULL, f, NULL)) /* free: times go with sqrt(scale) */
            for (int i = 6; i < 8; i++) {
                if (k == 0)
                    reference[i] = (double)f[i];
                CHECK_NEAR((double)f[i] * sqrt(scale) / reference[i], 1, SB_REAL_IS_FLOAT ? 1e-2 : 1e-9);
            }
        CHECK(f[5] < REAL(SB_REAL_IS_FLOAT ? 0.1 : 1e-5) * f[6]);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* The hash of a motion, with or without a question about modes in its middle. corotated 3: neither, with all else. */
static unsigned long long play(int corotated, sb_integrator integrator, int ask)
{
    sb_mesh mesh = scene_box(corotated ? SB_TET10 : SB_TET4, 3, 2, 2, sb_v3(REAL(0.15), REAL(0.1), REAL(0.1)), 0.1);
    sb_body_def def = sb_default_body_def();
    sb_modes_options options = sb_default_modes_options();
    unsigned long long hash;
    sb_real f[3];
    sb_body *body;
    def.mesh = &mesh;
    def.material = corotated == 1   ? sb_material_corotated(REAL(5e3), REAL(0.4), REAL(1000))
                   : corotated == 2 ? sb_material_corotated(REAL(5e3), REAL(0.4), REAL(1000))
                                    : sb_material_neo_hookean(REAL(5e3), REAL(0.4), REAL(1000));
    def.single_rotation = corotated == 2;
    def.integrator = integrator;
    def.gravity = sb_v3(0, REAL(1), REAL(-9.81));
    def.damping_mass = 1;
    if (corotated == 3) {
        const sb_real g = REAL(0.5), tau = REAL(0.02);
        def.material = sb_material_with_prony(def.material, &g, &tau, 1);
    }
    body = scene_body(&def);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    if (corotated == 3)
        hold_more(body, &mesh);
    for (int s = 1; s <= 8; s++) {
        CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
        if (ask && s == 4) {
            size_t bytes = (size_t)mesh.node_count * sizeof(sb_vec3);
            sb_vec3 *r = (sb_vec3 *)malloc(bytes);
            memcpy(r, sb_body_reactions(body), bytes);
            find(body, 3, NULL, f, NULL);
            options.at_present = 1;
            find(body, 3, &options, f, NULL);
            CHECK(memcmp(r, sb_body_reactions(body), bytes) == 0);
            free(r);
        }
    }
    hash = scene_hash(sb_body_displacements(body), (size_t)mesh.node_count * sizeof(sb_vec3)) ^
           scene_hash(sb_body_velocities(body), (size_t)mesh.node_count * sizeof(sb_vec3)) ^
           scene_hash(sb_body_reactions(body), (size_t)mesh.node_count * sizeof(sb_vec3));
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return hash;
}

static void test_leaves_no_trace(void)
{
    static const sb_integrator integrators[4] = {SB_EULER, SB_NEWMARK, SB_GENERALISED_ALPHA, SB_CENTRAL_DIFFERENCE};
    for (int k = 0; k < 4; k++)
        for (int corotated = 0; corotated < 4; corotated++)
            CHECK(play(corotated, integrators[k], 1) == play(corotated, integrators[k], 0));
}

/* ---- refusals ---- */

static void test_refusals(void)
{
    sb_mesh mesh = scene_box(SB_TET10, 5, 2, 2, sb_v3(REAL(0.2), REAL(0.1), REAL(0.1)), 0.1);
    sb_body *body = elastic_body(&mesh, sb_material_neo_hookean(REAL(5e3), REAL(0.4), REAL(1000)));
    sb_modes_options options = sb_default_modes_options(), bad;
    sb_vec3 *u = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof(sb_vec3));
    sb_real f[4] = {-1, -1, -1, -1};
    sb_modes_info info;
    sb_error error;
    int freedom;
    memset(&info, 0, sizeof info);
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    freedom = 3 * mesh.node_count;
    for (int i = 0; i < mesh.node_count; i++)
        freedom -= sb_body_supports(body)[i] ? 3 : 0;
    CHECK_RESULT(sb_body_modes(NULL, 1, NULL, f, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_modes(body, 1, NULL, NULL, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_modes(body, 0, NULL, f, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_body_modes(body, freedom + 1, NULL, f, NULL, NULL, &error), SB_ERROR_ARGUMENT);
    check_bad_numbers();
    for (int k = 0; k < 6; k++) {
        bad = options;
        if (k == 0)
            bad.cookie = 0;
        else if (k == 1)
            bad.tolerance = 0;
        else if (k == 2)
            bad.tolerance = 1;
        else if (k == 3)
            bad.tolerance = REAL(NAN);
        else if (k == 4)
            bad.max_iterations = 0;
        else
            memset(&bad.mass, 0x7f, sizeof bad.mass);
        CHECK_RESULT(sb_body_modes(body, 1, &bad, f, NULL, &info, &error), SB_ERROR_ARGUMENT);
        CHECK(error.message[0] != 0);
    }
    bad = options;
    bad.max_iterations = 1;
    CHECK_RESULT(sb_body_modes(body, 4, &bad, f, NULL, &info, &error), SB_ERROR_NOT_CONVERGED);
    CHECK(strstr(error.message, "mode ") != NULL && info.iterations == 1 && info.residual > 0);
    u[mesh.node_count - 1] = sb_v3(-1, 0, 0);
    CHECK_OK(sb_body_set_displacements(body, u));
    bad = options;
    bad.at_present = 1;
    CHECK_RESULT(sb_body_modes(body, 4, &bad, f, NULL, &info, &error), SB_ERROR_INVERTED);
    CHECK(error.element >= 0);
    for (int i = 0; i < 4; i++)
        CHECK(f[i] == -1);
    find(body, 4, NULL, f, NULL); /* about the undeformed shape nothing is wrong */
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    free(u);
}

static void test_memory(void)
{
    scene_memory memory = {0, 0, 0, 0};
    sb_mesh mesh = scene_box(SB_TET4, 3, 1, 1, sb_v3(REAL(0.3), REAL(0.1), REAL(0.1)), 0);
    sb_body_def def = sb_default_body_def();
    sb_error error;
    sb_real f[2] = {-1, -1};
    sb_body *body;
    int live, calls, failed = 0;
    def.mesh = &mesh;
    def.material = sb_material_linear(1000, REAL(0.3), 1000);
    def.allocator = scene_allocator(&memory);
    body = scene_body(&def);
    live = memory.live;
    calls = memory.calls;
    for (int k = 1;; k++) {
        sb_result result;
        memory.fail_at = calls + k;
        result = sb_body_modes(body, 2, NULL, f, NULL, NULL, &error);
        CHECK_INT(memory.live, live);
        if (result == SB_OK)
            break;
        failed++;
        CHECK_RESULT(result, SB_ERROR_MEMORY);
        CHECK(error.result == SB_ERROR_MEMORY && error.message[0] && f[0] == -1);
        calls = memory.calls;
    }
    CHECK(failed >= 2);
    memory.fail_at = 0;
    sb_body_destroy(body);
    CHECK_INT(memory.live, 0);
    sb_mesh_free(&mesh);
}

CHECK_SUITE(modes, {"references", test_references}, {"bar in closed form", test_bar},
            {"slender beam in closed form", test_beam}, {"every mode of a tetrahedron", test_every_mode},
            {"shapes", test_shapes}, {"a shape swings with its frequency", test_swing}, {"springs", test_springs},
            {"tied as merged", test_tied_as_merged}, {"Prony terms and pressure", test_prony_and_pressure},
            {"mass kinds", test_mass_kinds}, {"present shape", test_present_shape}, {"scale invariance", test_scale},
            {"leaves no trace", test_leaves_no_trace}, {"refusals", test_refusals}, {"failing memory", test_memory});
