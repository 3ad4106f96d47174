/* Faces that contact acts on: samples against integrals, areas, places in the matrix, boxes. They are internal, so that
 * this unit has the library for itself. */
#define SB_STATIC
#define SB_IMPLEMENTATION
#include "../softbody.h"

#include "check.h"
#include "scene.h"
#include "wedge.h"

static const sb_element_type faces_types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
enum { FACES_TYPES = 5 };

/* ---- meshes -------------------------------------------------------------------------------------------------- */

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

/* ---- samples --------------------------------------------------------------------------------------------------- */

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

CHECK_SUITE(contact_faces, {"sums over samples are integrals", test_faces_samples});
