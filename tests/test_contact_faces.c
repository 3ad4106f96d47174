/* Faces that contact acts on: samples against integrals, areas, places in the matrix, boxes. They are internal. */
#define SB_SPLIT_BUILD
#include "../src/softbody/body/body_private.h"
#include "../src/softbody/contact/contact_faces.h"

#include "check.h"
#include "scene.h"
#include "wedge.h"

static const sb_element_type faces_types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
enum { FACES_TYPES = 5 };

/* x = where a face's nodes are at rest */
static void faces_at_rest(const sbi_contact_faces *faces, const sb_body *body, int face, sb_vec3 *x)
{
    for (int a = 0; a < faces->sizes[face]; a++)
        x[a] = body->reference[sbi_contact_face_nodes(faces, face)[a]];
}

/* ---- meshes ------------------------------------------------------------------------------------------------------ */

/* Graded boxes whose nodes were shaken, those on a side within it, so that faces are flat and their edges straight. */
static sb_mesh faces_straight_mesh(sb_element_type type, const int cells[3], sb_vec3 size, unsigned long long *seed)
{
    sb_mesh corners = scene_box(sb_element_straight(type), cells[0], cells[1], cells[2], size, 0), mesh = corners;
    sb_real grade = REAL(check_random_in(seed, -0.3, 0.3));
    for (int i = 0; i < corners.node_count; i++) {
        sb_real *x[3], length[3];
        x[0] = &corners.nodes[i].x, x[1] = &corners.nodes[i].y, x[2] = &corners.nodes[i].z;
        length[0] = size.x, length[1] = size.y, length[2] = size.z;
        for (int k = 0; k < 3; k++) {
            sb_real at = *x[k] / length[k];
            if (at > REAL(1e-5) && at < 1 - REAL(1e-5))
                at += REAL(check_random_in(seed, -0.15, 0.15)) / REAL(cells[k]);
            *x[k] = length[k] * (at + grade * at * (1 - at));
        }
    }
    memset(&mesh, 0, sizeof mesh);
    if (type == SB_TET10)
        CHECK_OK(sb_mesh_to_tet10(&corners, NULL, &mesh, NULL));
    else if (type == SB_HEX20)
        CHECK_OK(sb_mesh_to_hex20(&corners, NULL, &mesh, NULL));
    else if (type == SB_HEX27)
        CHECK_OK(sb_mesh_to_hex27(&corners, NULL, &mesh, NULL));
    else
        return corners;
    sb_mesh_free(&corners);
    return mesh;
}

/* Turns, shears and scales it. */
static void faces_map(sb_mesh *mesh, double unit, unsigned long long *seed)
{
    sb_mat3 map = sb_m3_identity();
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            map.m[i][j] = REAL(unit) * (map.m[i][j] + REAL(check_random_in(seed, -0.2, 0.2)));
    for (int i = 0; i < mesh->node_count; i++)
        mesh->nodes[i] = sb_m3_apply(map, mesh->nodes[i]);
}

static void faces_bend(sb_mesh *mesh, double bend)
{
    for (int i = 0; i < mesh->node_count; i++) {
        sb_vec3 x = mesh->nodes[i];
        mesh->nodes[i] = sb_v3_madd(x, REAL(bend), sb_v3(x.y * x.z, x.x * x.x - x.z * x.z, x.x * x.y));
    }
}

static sb_body *faces_body(const sb_mesh *mesh, double slack)
{
    sb_body_def def = sb_default_body_def();
    def.mesh = mesh;
    def.material = sb_material_corotated(5000, REAL(0.4), 1000);
    def.slack = REAL(slack);
    return scene_body(&def);
}

static sb_mesh faces_random_mesh(int type, double bend, double unit, unsigned long long *seed)
{
    int cells[3];
    sb_mesh mesh;
    for (int k = 0; k < 3; k++)
        cells[k] = 1 + (int)check_random_in(seed, 0, 3.9);
    mesh = faces_straight_mesh(faces_types[type], cells, sb_v3(1, REAL(0.8), REAL(0.6)), seed);
    faces_bend(&mesh, bend);
    faces_map(&mesh, unit, seed);
    return mesh;
}

/* ---- samples ----------------------------------------------------------------------------------------------------- */

/* |x_r cross x_s| and the place of a point of a face. */
static double faces_at(const sbi_contact_faces *faces, const sb_body *body, int face, const sb_real xi[3],
                       sb_real *shape, sb_vec3 *at)
{
    sb_real gradient[SB_MAX_FACE_NODES][3];
    sb_vec3 r = sb_v3(0, 0, 0), s = r;
    const int *nodes = sbi_contact_face_nodes(faces, face);
    sb_element_shape(sbi_contact_face_type(faces, face), xi, shape, gradient);
    *at = sb_v3(0, 0, 0);
    for (int a = 0; a < faces->sizes[face]; a++) {
        sb_vec3 x = body->reference[nodes[a]];
        *at = sb_v3_madd(*at, shape[a], x);
        r = sb_v3_madd(r, gradient[a][0], x);
        s = sb_v3_madd(s, gradient[a][1], x);
    }
    return (double)sb_v3_norm(sb_v3_cross(r, s));
}

/* Sums over samples of n parts against the face's quadrature: integrals of all N, and of a function of the node's
 * places (quadratic where faces reproduce that). */
static void faces_check_sums(const sbi_contact_faces *faces, const sb_body *body, int face, int n, double tolerance)
{
    sb_real points[SB_MAX_QUADRATURE_POINTS][3], weights[SB_MAX_QUADRATURE_POINTS], shape[SB_MAX_FACE_NODES];
    const sbi_contact_rule *rule = sbi_contact_face_rule(faces, face, n);
    sb_element_type type = sbi_contact_face_type(faces, face);
    int size = faces->sizes[face], count = sb_element_quadrature(type, SB_QUADRATURE_FACE, points, weights);
    double exact[SB_MAX_FACE_NODES] = {0}, area = 0, sum = 0, sums[SB_MAX_FACE_NODES] = {0};
    for (int p = 0; p < count; p++) {
        sb_vec3 at;
        double part = (double)weights[p] * faces_at(faces, body, face, points[p], shape, &at);
        area += part;
        for (int a = 0; a < size; a++)
            exact[a] += part * (double)shape[a];
    }
    for (int i = 0; i < rule->count; i++) {
        const sb_real *w = sbi_contact_sample_weights(faces, face, n, i);
        double part = (double)sbi_contact_sample_area(faces, body, face, n, i), all = 0;
        sum += part;
        for (int a = 0; a < size; a++) {
            sums[a] += part * (double)w[a];
            all += (double)w[a];
        }
        CHECK_NEAR(all, 1, scene_tolerance(1e-15, 8));
    }
    CHECK_NEAR(sum / area, 1, tolerance);
    CHECK_NEAR((double)faces->areas[face] / area, 1, tolerance);
    for (int a = 0; a < size; a++)
        CHECK_NEAR(sums[a] / area, exact[a] / area, tolerance);
    for (int a = 0; a < 3 && type == SB_TRI6; a++)
        CHECK_NEAR(sums[a] / area, 0, tolerance);
}

static void test_faces_samples(void)
{
    unsigned long long seed = 11;
    for (int round = 0; round < (check_quick() ? 5 : 30); round++) {
        double unit = pow(10, check_random_in(&seed, -3, 3));
        sb_mesh mesh = faces_random_mesh(round % FACES_TYPES, 0, unit, &seed);
        sb_body *body = faces_body(&mesh, 0);
        sbi_contact_faces *faces;
        sb_error error;
        if (CHECK_OK(sbi_contact_faces_create(body, NULL, &faces, &error))) {
            CHECK_INT(faces->flat_count, 0);
            for (int f = 0; f < faces->face_end; f++) {
                const sbi_contact_kind *kind = &faces->kinds[faces->sizes[f]];
                for (int n = kind->least; n <= kind->most; n++)
                    faces_check_sums(faces, body, f, n, scene_tolerance(1e-13, 200));
            }
            sbi_contact_faces_destroy(faces);
        }
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* ---- integrals in space ------------------------------------------------------------------------------------------ */

typedef struct faces_polynomial {
    double c[10];
} faces_polynomial;

static double faces_value(const faces_polynomial *f, sb_vec3 at, double unit)
{
    double x = (double)at.x / unit, y = (double)at.y / unit, z = (double)at.z / unit;
    return f->c[0] + f->c[1] * x + f->c[2] * y + f->c[3] * z + f->c[4] * x * x + f->c[5] * y * y + f->c[6] * z * z +
           f->c[7] * x * y + f->c[8] * y * z + f->c[9] * z * x;
}

/* Over the flat polygon of a face's corners: triangles with values at the middles of their edges. */
static double faces_integral(const faces_polynomial *f, const sb_vec3 *x, int corners, double unit)
{
    double sum = 0;
    for (int t = 1; t + 1 < corners; t++) {
        sb_vec3 a = x[0], b = x[t], c = x[t + 1];
        double area = 0.5 * (double)sb_v3_norm(sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(c, a)));
        sum += area / 3 *
               (faces_value(f, sb_v3_scale(REAL(0.5), sb_v3_add(a, b)), unit) +
                faces_value(f, sb_v3_scale(REAL(0.5), sb_v3_add(b, c)), unit) +
                faces_value(f, sb_v3_scale(REAL(0.5), sb_v3_add(c, a)), unit));
    }
    return sum;
}

/* Functions that a straight face reproduces from its nodes' values: quadratic ones for tri6 and quad9, else linear. */
static void test_faces_functions(void)
{
    unsigned long long seed = 12;
    for (int round = 0; round < (check_quick() ? 5 : 30); round++) {
        double unit = pow(10, check_random_in(&seed, -3, 3));
        sb_mesh mesh = faces_random_mesh(round % FACES_TYPES, 0, unit, &seed);
        sb_body *body = faces_body(&mesh, 0);
        sbi_contact_faces *faces;
        if (!CHECK_OK(sbi_contact_faces_create(body, NULL, &faces, NULL)))
            return;
        for (int f = 0; f < faces->face_end; f++) {
            const sbi_contact_kind *kind = &faces->kinds[faces->sizes[f]];
            faces_polynomial function;
            sb_vec3 x[SB_MAX_FACE_NODES];
            faces_at_rest(faces, body, f, x);
            for (int k = 0; k < 10; k++)
                function.c[k] =
                    k < 4 || kind->type == SB_TRI6 || kind->type == SB_QUAD9 ? check_random_in(&seed, -1, 1) : 0;
            for (int n = kind->least; n <= kind->most; n++) {
                double sum = 0;
                for (int i = 0; i < kind->rules[n].count; i++)
                    for (int a = 0; a < kind->nodes; a++)
                        sum += (double)sbi_contact_sample_area(faces, body, f, n, i) *
                               (double)sbi_contact_sample_weights(faces, f, n, i)[a] *
                               faces_value(&function, x[a], unit);
                CHECK_NEAR(sum / (double)faces->areas[f],
                           faces_integral(&function, x, kind->corners, unit) / (double)faces->areas[f],
                           scene_tolerance(1e-12, 500));
            }
        }
        sbi_contact_faces_destroy(faces);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* ---- spacing ----------------------------------------------------------------------------------------------------- */

static sb_vec3 faces_point(const sb_vec3 *x, const sb_real *shape, int nodes)
{
    sb_vec3 sum = sb_v3(0, 0, 0);
    for (int a = 0; a < nodes; a++)
        sum = sb_v3_madd(sum, shape[a], x[a]);
    return sum;
}

static void faces_random_xi(const sbi_contact_kind *kind, unsigned long long *seed, sb_real xi[3])
{
    double r = check_random(seed), s = check_random(seed);
    if (kind->corners == 3 && r + s > 1)
        r = 1 - r, s = 1 - s;
    xi[0] = REAL(kind->corners == 3 ? r : 2 * r - 1);
    xi[1] = REAL(kind->corners == 3 ? s : 2 * s - 1);
    xi[2] = 0;
}

/* Largest distance of a face's points from its samples. */
static double faces_farthest(const sbi_contact_faces *faces, const sb_body *body, int face, int n, int points,
                             unsigned long long *seed)
{
    const sbi_contact_kind *kind = &faces->kinds[faces->sizes[face]];
    sb_vec3 x[SB_MAX_FACE_NODES];
    double farthest = 0;
    faces_at_rest(faces, body, face, x);
    for (int p = 0; p < points; p++) {
        sb_real xi[3], shape[SB_MAX_FACE_NODES];
        double nearest = 1e300;
        sb_vec3 at;
        faces_random_xi(kind, seed, xi);
        sb_element_shape(kind->type, xi, shape, NULL);
        at = faces_point(x, shape, kind->nodes);
        for (int i = 0; i < kind->rules[n].count; i++) {
            const sb_real *w = sbi_contact_sample_weights(faces, face, n, i);
            double d = (double)sb_v3_norm(sb_v3_sub(at, faces_point(x, w, kind->nodes)));
            nearest = d < nearest ? d : nearest;
        }
        farthest = nearest > farthest ? nearest : farthest;
    }
    return farthest;
}

/* Any point has a sample near by, unless the tool is too thin for the mesh; larger radii never take more parts. */
static void test_faces_spacing(void)
{
    unsigned long long seed = 13;
    double farthest[2] = {0, 0};
    for (int round = 0; round < (check_quick() ? 10 : 60); round++) {
        double unit = pow(10, check_random_in(&seed, -3, 3));
        sb_mesh mesh = faces_random_mesh(round % FACES_TYPES, 0, unit, &seed);
        sb_body *body = faces_body(&mesh, 0);
        sbi_contact_faces *faces;
        sb_real thinnest, radius;
        int hardest = -1, most;
        if (!CHECK_OK(sbi_contact_faces_create(body, NULL, &faces, NULL)))
            return;
        thinnest = sbi_contact_faces_thinnest(faces, &hardest);
        if (!CHECK(hardest >= 0 && thinnest > 0))
            return;
        most = faces->kinds[faces->sizes[hardest]].most; /* parts as long as they may be, there */
        radius = thinnest * REAL(1.0001) * REAL(most) / REAL(2 + round / FACES_TYPES % (most - 1));
        for (int f = 0; f < faces->face_end; f++) {
            const sbi_contact_kind *kind = &faces->kinds[faces->sizes[f]];
            int n = sbi_contact_face_parts(faces, f, radius);
            double *far = &farthest[kind->corners == 4];
            *far = fmax(*far, faces_farthest(faces, body, f, n, f == hardest ? 400 : 10, &seed) / (double)radius);
            CHECK(n >= kind->least && n <= kind->most);
            CHECK(sbi_contact_face_parts(faces, f, 2 * radius) <= n);
            CHECK_INT(sbi_contact_face_parts(faces, f, SB_REAL_MAX), kind->least);
            CHECK_INT(sbi_contact_face_parts(faces, f, REAL(1e-30)), kind->most);
        }
        sbi_contact_faces_destroy(faces);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
    CHECK(farthest[0] < 0.3 && farthest[1] < 0.34);
}

/* ---- which faces ------------------------------------------------------------------------------------------------- */

/* The faces are those of the boundary that meshes have; numbers of nodes and cells go through these tables. */
static void faces_check_boundary(const sbi_contact_faces *faces, const sb_body *body)
{
    sb_mesh mesh;
    sb_boundary boundary;
    int *nodes = (int *)calloc((size_t)sb_body_node_count(body), sizeof(int));
    int *cells = (int *)calloc((size_t)sb_body_element_count(body), sizeof(int)), wrong = 0;
    double area = 0, of_nodes = 0;
    if (!CHECK_OK(sb_body_get_mesh(body, NULL, &mesh, nodes, cells, NULL)) ||
        !CHECK_OK(sb_mesh_boundary(&mesh, 0, NULL, &boundary, NULL)))
        return;
    if (CHECK_INT(faces->face_end, boundary.surface.element_count))
        for (int f = 0, row = 0; f < faces->face_end; f++) {
            wrong += cells[faces->elements[f]] != boundary.elements[row] || faces->sides[f] != boundary.faces[row];
            wrong += faces->regions[f] != body->cell_material[faces->elements[f]];
            wrong += sbi_contact_face_type(faces, f) != boundary.surface.element_type;
            for (int a = 0; a < faces->sizes[f]; a++)
                wrong +=
                    nodes[sbi_contact_face_nodes(faces, f)[a]] != boundary.surface.elements[row * faces->sizes[f] + a];
            row++;
        }
    CHECK_INT(wrong, 0);
    for (int f = 0; f < faces->face_end; f++)
        area += (double)faces->areas[f];
    for (int i = 0; i < sb_body_node_count(body); i++) {
        of_nodes += (double)sbi_contact_node_area(faces, i);
        wrong += sbi_contact_node_area(faces, i) < 0;
    }
    CHECK_INT(wrong, 0);
    CHECK_NEAR(of_nodes / area, 1, scene_tolerance(1e-13, 100));
    CHECK_NEAR(area / (double)sb_mesh_surface_area(&boundary.surface), 1, 1e-3);
    sb_boundary_free(&boundary);
    sb_mesh_free(&mesh);
    free(nodes);
    free(cells);
}

static void test_faces_are_the_boundary(void)
{
    unsigned long long seed = 14;
    for (int round = 0; round < (check_quick() ? 10 : 40); round++) {
        double unit = pow(10, check_random_in(&seed, -3, 3));
        sb_mesh mesh = faces_random_mesh(round % FACES_TYPES, round % 2 ? 0.1 : 0, unit, &seed);
        sb_body *body = faces_body(&mesh, round % 3 ? 0.2 : 0);
        sbi_contact_faces *faces;
        if (round % 3 == 2 && mesh.element_count > 30)
            scene_remove_cells(body);
        if (CHECK_OK(sbi_contact_faces_create(body, NULL, &faces, NULL)))
            faces_check_boundary(faces, body);
        sbi_contact_faces_destroy(faces);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* What is a node's: a third of its triangles; of a flat face of tet10 nothing of the corners by their integrals, so
 * that shares stand for them. */
static void test_faces_node_areas(void)
{
    sb_mesh mesh = scene_box(SB_TET4, 3, 2, 2, sb_v3(3, 2, 1), 0);
    sb_body *body = faces_body(&mesh, 0);
    sbi_contact_faces *faces;
    double *expected = (double *)calloc((size_t)mesh.node_count, sizeof *expected), sum = 0;
    if (CHECK_OK(sbi_contact_faces_create(body, NULL, &faces, NULL))) {
        for (int f = 0; f < faces->face_end; f++)
            for (int a = 0; a < 3; a++)
                expected[sbi_contact_face_nodes(faces, f)[a]] += (double)faces->areas[f] / 3;
        for (int i = 0; i < mesh.node_count; i++) {
            CHECK_NEAR(sbi_contact_node_area(faces, i), expected[i], scene_tolerance(1e-14, 20));
            sum += expected[i];
        }
        CHECK_NEAR(sum, 22, scene_tolerance(1e-12, 200));
        sbi_contact_faces_destroy(faces);
    }
    free(expected);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    for (int type = 1; type < FACES_TYPES; type++) {
        sb_real least = 1, most = 0;
        mesh = scene_box(faces_types[type], 2, 2, 2, sb_v3(1, 1, 1), 0);
        body = faces_body(&mesh, 0);
        if (CHECK_OK(sbi_contact_faces_create(body, NULL, &faces, NULL))) {
            for (int f = 0; f < faces->face_end; f++)
                for (int a = 0; a < faces->sizes[f]; a++) {
                    sb_real area = sbi_contact_node_area(faces, sbi_contact_face_nodes(faces, f)[a]);
                    least = sb_min(least, area);
                    most = sb_max(most, area);
                }
            CHECK(least > REAL(0.004) && most < REAL(0.3)); /* of 6 in all */
            sbi_contact_faces_destroy(faces);
        }
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* Wedges have triangles and quads. */
static void test_faces_of_wedges(void)
{
    sb_element_table table = wedge_table();
    sb_mesh mesh = wedge_box(&table, 3, 2, 2, sb_v3(3, 2, 1), 0.1);
    sb_body *body = faces_body(&mesh, 0);
    sbi_contact_faces *faces;
    int triangles = 0, quads = 0, found[200];
    double area = 0;
    if (CHECK_OK(sbi_contact_faces_create(body, NULL, &faces, NULL))) {
        for (int f = 0; f < faces->face_end; f++) {
            const sbi_contact_kind *kind = &faces->kinds[faces->sizes[f]];
            triangles += sbi_contact_face_type(faces, f) == SB_TRI3;
            quads += sbi_contact_face_type(faces, f) == SB_QUAD4;
            area += (double)faces->areas[f];
            for (int n = kind->least; n <= kind->most; n++)
                faces_check_sums(faces, body, f, n, scene_tolerance(1e-13, 200));
        }
        CHECK_INT(triangles, 2 * 2 * 3 * 2);
        CHECK_INT(quads, 2 * (2 * 2 + 3 * 2));
        CHECK_NEAR(area, 22, scene_tolerance(1e-12, 200));
        CHECK_INT(sbi_contact_faces_query(faces, sb_v3(-1, -1, -1), sb_v3(4, 4, 4), found, 200), triangles + quads);
        CHECK(found[0] == 0 && found[triangles + quads - 1] == triangles + quads - 1);
        sbi_contact_faces_destroy(faces);
    }
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* Two tets in one place, as an immersed grid's cells may be: their faces are outer ones, once. */
static void test_faces_of_cells_in_one_place(void)
{
    sb_vec3 nodes[4] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    int cells[8] = {0, 1, 2, 3, 1, 2, 0, 3};
    sb_mesh mesh;
    sb_body *body;
    sbi_contact_faces *faces;
    memset(&mesh, 0, sizeof mesh);
    mesh.node_count = 4, mesh.nodes = nodes;
    mesh.element_type = SB_TET4, mesh.element_count = 2, mesh.elements = cells;
    body = faces_body(&mesh, 0);
    if (body && CHECK_OK(sbi_contact_faces_create(body, NULL, &faces, NULL))) {
        CHECK_INT(faces->face_end, 4);
        for (int f = 0; f < 4; f++)
            CHECK_INT(faces->elements[f], 0);
        sbi_contact_faces_destroy(faces);
    }
    sb_body_destroy(body);
}

/* ---- boxes ------------------------------------------------------------------------------------------------------- */

static int faces_has(const int *found, int count, int face)
{
    for (int i = 0; i < count; i++)
        if (found[i] == face)
            return 1;
    return 0;
}

/* Points of curved, moving faces are found by a box around them. */
static void test_faces_boxes(void)
{
    unsigned long long seed = 15;
    for (int round = 0; round < (check_quick() ? 5 : 25); round++) {
        double unit = pow(10, check_random_in(&seed, -3, 3)), lost = 0;
        sb_mesh mesh = faces_random_mesh(round % FACES_TYPES, 0.15, unit, &seed);
        sb_body *body = faces_body(&mesh, 0);
        sb_vec3 *u = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof *u), *v = u;
        sbi_contact_faces *faces;
        int *found = (int *)calloc(1000, sizeof(int));
        sb_real dt = REAL(check_random_in(&seed, 0, 0.1));
        if (!CHECK_OK(sbi_contact_faces_create(body, NULL, &faces, NULL)))
            return;
        for (int k = 0; k < 2; k++) { /* displacements, then velocities */
            for (int i = 0; i < mesh.node_count; i++)
                for (int axis = 0; axis < 3; axis++)
                    *(axis == 0   ? &u[i].x
                      : axis == 1 ? &u[i].y
                                  : &u[i].z) = REAL(unit * (10 * (1 - k) + check_random_in(&seed, -0.3, 0.3)));
            if (k == 0)
                CHECK_OK(sb_body_set_displacements(body, u));
        }
        sbi_contact_faces_refit(faces, sb_body_positions(body), v, dt);
        for (int p = 0; p < 400; p++) {
            int f = (int)check_random_in(&seed, 0, faces->face_end - 0.001), count;
            sb_real xi[3], shape[SB_MAX_FACE_NODES], way = REAL(check_random(&seed));
            sb_vec3 at = sb_v3(0, 0, 0);
            faces_random_xi(&faces->kinds[faces->sizes[f]], &seed, xi);
            sb_element_shape(sbi_contact_face_type(faces, f), xi, shape, NULL);
            for (int a = 0; a < faces->sizes[f]; a++) {
                int node = sbi_contact_face_nodes(faces, f)[a];
                at = sb_v3_madd(at, shape[a], sb_v3_madd(sb_body_positions(body)[node], way * dt, v[node]));
            }
            count = sbi_contact_faces_query(faces, at, at, found, 1000);
            lost += !faces_has(found, count, f);
        }
        CHECK(lost == 0);
        sbi_contact_faces_destroy(faces);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
        free(u);
        free(found);
    }
}

/* ---- blocks ------------------------------------------------------------------------------------------------------ */

static int faces_wrong_blocks(sbi_contact_faces *faces, const sb_body *body)
{
    int wrong = 0;
    for (int f = 0; f < faces->face_end; f++) {
        const int *nodes = sbi_contact_face_nodes(faces, f), *blocks = sbi_contact_face_blocks(faces, body, f);
        int size = faces->sizes[f];
        for (int a = 0; a < size; a++)
            for (int b = 0; b < size; b++) {
                int q = blocks[a * size + b], row = nodes[a];
                wrong += q < body->matrix.row_start[row] || q >= body->matrix.row_end[row] ||
                         body->matrix.columns[q] != nodes[b];
            }
    }
    return wrong;
}

/* Before and after couplings between far nodes, which move all blocks. */
static void test_faces_blocks(void)
{
    unsigned long long seed = 16;
    for (int round = 0; round < 2 * FACES_TYPES; round++) {
        sb_mesh mesh = faces_random_mesh(round % FACES_TYPES, 0.1, 1, &seed);
        sb_body *body = faces_body(&mesh, round < FACES_TYPES ? 0 : 0.2);
        sbi_contact_faces *faces;
        int start[2] = {0, 2}, nodes[2], version = body->pattern_version;
        sb_real weights[2] = {REAL(0.5), REAL(0.5)}, stiffness = 1;
        sb_vec3 target = sb_v3(0, 0, 0);
        sb_mapping mapping;
        memset(&mapping, 0, sizeof mapping);
        nodes[0] = 0, nodes[1] = mesh.node_count - 1;
        mapping.row_count = 1;
        mapping.row_start = start, mapping.nodes = nodes, mapping.weights = weights;
        if (!CHECK_OK(sbi_contact_faces_create(body, NULL, &faces, NULL)))
            return;
        CHECK_INT(faces_wrong_blocks(faces, body), 0);
        for (int more = 0; more < 3; more++, nodes[1]--) {
            CHECK_OK(sb_body_add_mapping(body, &mapping, &stiffness, 1, &target, NULL, NULL));
            CHECK_INT(faces_wrong_blocks(faces, body), 0);
        }
        CHECK(body->pattern_version > version || mesh.element_count < 8);
        sbi_contact_faces_destroy(faces);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

/* ---- degenerate, memory ------------------------------------------------------------------------------------------ */

/* Faces that have lost their area have no samples, and are not found. No body is made so; material may come to it. */
static void test_faces_without_area(void)
{
    for (int type = 0; type < FACES_TYPES; type++) {
        sb_mesh mesh = scene_box(faces_types[type], 2, 2, 2, sb_v3(1, 1, 1), 0);
        sb_body *body = faces_body(&mesh, 0);
        sbi_contact_faces *faces, *none = NULL;
        int found[300], count;
        sb_error error;
        for (int i = 0; i < mesh.node_count; i++) /* one side becomes a line, and others lose half of it */
            if (body->reference[i].x > REAL(0.9))
                body->reference[i].y = 0;
        if (CHECK_OK(sbi_contact_faces_create(body, NULL, &faces, NULL))) {
            CHECK(faces->flat_count > 0 && faces->flat_count < faces->face_end);
            count = sbi_contact_faces_query(faces, sb_v3(-9, -9, -9), sb_v3(9, 9, 9), found, 300);
            CHECK_INT(count, faces->face_end - faces->flat_count);
            for (int i = 0; i < count; i++)
                CHECK(faces->areas[found[i]] > 0);
            sbi_contact_faces_destroy(faces);
        }
        for (int i = 0; i < mesh.node_count; i++)
            body->reference[i] = sb_v3(body->reference[i].x, 0, 0);
        CHECK_RESULT(sbi_contact_faces_create(body, NULL, &none, &error), SB_ERROR_MESH);
        CHECK(none == NULL);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

static void test_faces_memory(void)
{
    for (int slack = 0; slack < 2; slack++) {
        sb_mesh mesh = scene_box(SB_TET10, 2, 1, 1, sb_v3(2, 1, 1), 0);
        sb_body *body = faces_body(&mesh, 0.2 * slack);
        sb_result result = SB_ERROR_MEMORY;
        for (int fail_at = 1; result != SB_OK && fail_at < 100; fail_at++) {
            scene_memory memory = {0, 0, 0, 0};
            sb_allocator allocator = scene_allocator(&memory);
            sbi_contact_faces *faces = NULL;
            sb_error error;
            memory.fail_at = fail_at;
            result = sbi_contact_faces_create(body, &allocator, &faces, &error);
            if (result != SB_OK) {
                CHECK_RESULT(result, SB_ERROR_MEMORY);
                CHECK(faces == NULL && error.message[0]);
            }
            sbi_contact_faces_destroy(faces);
            CHECK_INT(memory.live, 0);
        }
        CHECK_OK(result);
        sb_body_destroy(body);
        sb_mesh_free(&mesh);
    }
}

CHECK_SUITE(contact_faces, {"sums over samples are integrals", test_faces_samples},
            {"functions in space", test_faces_functions}, {"spacing of samples", test_faces_spacing},
            {"the boundary's faces", test_faces_are_the_boundary}, {"areas of nodes", test_faces_node_areas},
            {"wedges", test_faces_of_wedges}, {"cells in one place", test_faces_of_cells_in_one_place},
            {"boxes hold moving faces", test_faces_boxes}, {"blocks follow the pattern", test_faces_blocks},
            {"faces without area", test_faces_without_area}, {"memory", test_faces_memory});
