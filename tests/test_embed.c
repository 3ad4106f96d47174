/* Embedding: places of points, motions reproduced, normals, transpose, failures. */
#include "scene.h"

static const sb_element_type embed_types[5] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};

/* A block of the size (0.2, 0.1, 0.1) m, quadratic ones with edges that bulge a little. */
static sb_mesh embed_block(sb_element_type type, double size)
{
    sb_mesh mesh = scene_box(type, 4, 2, 2, sb_v3(REAL(0.2), REAL(0.1), REAL(0.1)), 0.1);
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 *x = &mesh.nodes[i];
        double swell = type == SB_TET4 || type == SB_HEX8 ? 0 : 0.1;
        double along = (double)x->x / 0.2;
        x->y = REAL((double)x->y * (1 + swell * along * (1 - along)));
        *x = sb_v3_scale(REAL(size), *x);
    }
    CHECK_OK(sb_mesh_validate(&mesh, NULL));
    return mesh;
}

/* Random points in the box of a mesh enlarged by `margin` of its size on each side. */
static sb_vec3 *embed_cloud(const sb_mesh *mesh, int count, double margin)
{
    sb_vec3 low, high, *points = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)count);
    unsigned long long seed = 11;
    sb_mesh_bounds(mesh, &low, &high);
    for (int i = 0; i < count; i++) {
        double x = check_random_in(&seed, -margin, 1 + margin), y = check_random_in(&seed, -margin, 1 + margin);
        double z = check_random_in(&seed, -margin, 1 + margin);
        points[i] = sb_v3(low.x + REAL(x) * (high.x - low.x), low.y + REAL(y) * (high.y - low.y),
                          low.z + REAL(z) * (high.z - low.z));
    }
    return points;
}

static sb_embedding *embed_make(const sb_embedding_def *def)
{
    sb_embedding *embedding = NULL;
    sb_error error;
    if (sb_embedding_create(def, &embedding, &error) != SB_OK)
        printf("%s: %s\n", sb_result_string(error.result), error.message);
    CHECK(embedding != NULL);
    return embedding;
}

static sb_embedding *embed_points(const sb_mesh *mesh, const sb_vec3 *points, int count, sb_embedding_kind kind)
{
    sb_embedding_def def = sb_default_embedding_def();
    def.mesh = mesh;
    def.points = points;
    def.point_count = count;
    def.kind = kind;
    return embed_make(&def);
}

/* x -> a x + shift */
static void embed_transform(const sb_vec3 *x, int count, sb_mat3 a, sb_vec3 shift, sb_vec3 *out)
{
    for (int i = 0; i < count; i++)
        out[i] = sb_v3_add(sb_m3_apply(a, x[i]), shift);
}

static sb_mat3 embed_rotation(void)
{
    return sb_quat_to_mat3(sb_quat_from_rotation_vector(sb_v3(REAL(0.7), REAL(-1.9), REAL(0.4))));
}

/* A smooth nonlinear deformation of a body of about `size` m. */
static void embed_bend(const sb_vec3 *x, int count, double size, sb_vec3 *out)
{
    for (int i = 0; i < count; i++) {
        double u = (double)x[i].x / size, v = (double)x[i].y / size, w = (double)x[i].z / size;
        out[i] = sb_v3(REAL(size * (u + 0.6 * v * w)), REAL(size * (v + 0.5 * u * u - 0.3 * w)),
                       REAL(size * (w + 0.4 * u * v + 0.2 * v)));
    }
}

/* ---- places ---- */

/* Smallest distance to a mesh over a lattice of parameters in every element. */
static double embed_brute_distance(const sb_mesh *mesh, sb_vec3 point, int cells)
{
    double best = 1e300;
    int width = sb_mesh_element_width(mesh), is_box = sb_element_straight(mesh->element_type) == SB_HEX8;
    for (int i = 0; i <= cells; i++)
        for (int j = 0; j <= cells; j++)
            for (int k = 0; k <= cells; k++) {
                sb_real xi[3], shape[SB_MAX_ELEMENT_NODES], step = REAL(1) / REAL(cells);
                if (!is_box && i + j + k > cells)
                    continue;
                xi[0] = REAL(i) * step, xi[1] = REAL(j) * step, xi[2] = REAL(k) * step;
                for (int a = 0; is_box && a < 3; a++)
                    xi[a] = 2 * xi[a] - 1;
                sb_element_shape(mesh->element_type, xi, shape, NULL);
                for (int e = 0; e < mesh->element_count; e++) {
                    sb_vec3 x = sb_v3(0, 0, 0);
                    double d;
                    for (int a = 0; a < width; a++)
                        x = sb_v3_madd(x, shape[a], mesh->nodes[mesh->elements[e * width + a]]);
                    d = (double)sb_v3_norm(sb_v3_sub(x, point));
                    best = d < best ? d : best;
                }
            }
    return best;
}

static sb_vec3 embed_place(const sb_mesh *mesh, const sb_embedded_point *place)
{
    sb_real shape[SB_MAX_ELEMENT_NODES];
    sb_vec3 x = sb_v3(0, 0, 0);
    int width = sb_mesh_element_width(mesh);
    sb_element_shape(mesh->element_type, place->xi, shape, NULL);
    for (int a = 0; a < width; a++)
        x = sb_v3_madd(x, shape[a], mesh->nodes[mesh->elements[place->element * width + a]]);
    return x;
}

/* 1 when xi lies in the element's domain to `slack`. */
static int embed_in_domain(sb_element_type type, const sb_real xi[3], double slack)
{
    double x = (double)xi[0], y = (double)xi[1], z = (double)xi[2];
    if (sb_element_straight(type) == SB_HEX8)
        return fabs(x) <= 1 + slack && fabs(y) <= 1 + slack && fabs(z) <= 1 + slack;
    return x >= -slack && y >= -slack && z >= -slack && x + y + z <= 1 + slack;
}

static void test_closest(void)
{
    for (int t = 0; t < 5; t++) {
        enum { COUNT = 60, CELLS = 12 };
        const double spacing = 0.18 / (double)(int)CELLS; /* elements are at most this times CELLS across */
        sb_mesh mesh = embed_block(embed_types[t], 1);
        sb_vec3 *points = embed_cloud(&mesh, COUNT, 0.3);
        sb_embedding *embedding = embed_points(&mesh, points, COUNT, SB_EMBED_PLAIN);
        for (int i = 0; i < COUNT && embedding; i += check_quick() ? 4 : 1) {
            sb_embedded_point place;
            double brute = embed_brute_distance(&mesh, points[i], CELLS), d;
            CHECK_OK(sb_embedding_get_point(embedding, i, &place));
            d = (double)sb_v3_norm(sb_v3_sub(embed_place(&mesh, &place), points[i]));
            CHECK_NEAR(d, place.distance, scene_tolerance(1e-14, 4));
            CHECK(embed_in_domain(mesh.element_type, place.xi, scene_tolerance(1e-9, 200)));
            CHECK((place.hold == SB_EMBEDDED_INSIDE) == (place.distance == 0 || d < scene_tolerance(1e-14, 4)));
            CHECK(d <= brute + scene_tolerance(1e-12, 10));
            CHECK(d >= brute - spacing);
        }
        sb_embedding_destroy(embedding);
        free(points);
        sb_mesh_free(&mesh);
    }
}

/* Points made from known parameters of curved elements come back with them. */
static void test_parameters(void)
{
    for (int t = 0; t < 5; t++) {
        enum { COUNT = 200 };
        sb_mesh mesh = embed_block(embed_types[t], 1);
        sb_embedded_point made[COUNT], found;
        sb_vec3 points[COUNT];
        unsigned long long seed = 5;
        sb_embedding *embedding;
        for (int i = 0; i < COUNT; i++) {
            memset(&made[i], 0, sizeof made[i]);
            made[i].element = (int)check_random_in(&seed, 0, mesh.element_count - 0.01);
            for (int k = 0; k < 3; k++)
                made[i].xi[k] =
                    REAL(sb_element_straight(mesh.element_type) == SB_HEX8 ? check_random_in(&seed, -0.98, 0.98)
                                                                           : check_random_in(&seed, 0.01, 0.33));
            points[i] = embed_place(&mesh, &made[i]);
        }
        embedding = embed_points(&mesh, points, COUNT, SB_EMBED_SMOOTH);
        CHECK_INT(sb_embedding_get_report(embedding).inside, COUNT);
        CHECK_INT(sb_embedding_get_report(embedding).farthest_point, -1);
        for (int i = 0; i < COUNT && embedding; i++) {
            CHECK_OK(sb_embedding_get_point(embedding, i, &found));
            CHECK_INT(found.element, made[i].element);
            for (int k = 0; k < 3; k++)
                CHECK_NEAR(found.xi[k], made[i].xi[k], scene_tolerance(1e-12, 200));
            CHECK(found.distance == 0);
        }
        sb_embedding_destroy(embedding);
        sb_mesh_free(&mesh);
    }
}

/* Distances along normals of a ball are radii. */
static void test_ball(void)
{
    for (int t = 0; t < 2; t++) {
        enum { COUNT = 300 };
        sb_mesh mesh;
        sb_vec3 points[COUNT];
        unsigned long long seed = 3;
        sb_embedding *embedding;
        double worst = 0;
        memset(&mesh, 0, sizeof mesh);
        CHECK_OK(
            sb_mesh_ellipsoid(t ? SB_HEX8 : SB_TET10, sb_v3(REAL(0.1), REAL(0.1), REAL(0.1)), 12, NULL, &mesh, NULL));
        for (int i = 0; i < COUNT; i++) {
            sb_vec3 v = sb_v3(REAL(check_random_in(&seed, -1, 1)), REAL(check_random_in(&seed, -1, 1)),
                              REAL(check_random_in(&seed, -1, 1)));
            points[i] = sb_v3_scale(REAL(check_random_in(&seed, 0.101, 0.15)) / sb_v3_norm(v), v);
        }
        embedding = embed_points(&mesh, points, COUNT, SB_EMBED_SMOOTH);
        CHECK_INT(sb_embedding_get_report(embedding).offset, COUNT);
        for (int i = 0; i < COUNT && embedding; i++) {
            sb_embedded_point place;
            double d;
            CHECK_OK(sb_embedding_get_point(embedding, i, &place));
            d = fabs((double)place.distance - ((double)sb_v3_norm(points[i]) - 0.1));
            worst = d > worst ? d : worst;
        }
        CHECK_NEAR(worst, 0, 0.0035); /* the facets of 12 cells lie up to 1 - cos(pi/12) inside */
        sb_embedding_destroy(embedding);
        sb_mesh_free(&mesh);
    }
}

/* ---- motions ---- */

/* A block bent to half a ring: towards its centre of curvature normals meet. */
static sb_mesh embed_ring(sb_element_type type)
{
    sb_mesh mesh = scene_box(type, 12, 2, 2, sb_v3(REAL(3.14159), REAL(0.4), REAL(0.4)), 0);
    for (int i = 0; i < mesh.node_count; i++) {
        sb_vec3 x = mesh.nodes[i];
        double angle = (double)x.x, radius = 0.8 + (double)x.y;
        mesh.nodes[i] = sb_v3(REAL(-radius * cos(angle)), REAL(-radius * sin(angle)), x.z);
    }
    sb_mesh_orient(&mesh, NULL, NULL);
    CHECK_OK(sb_mesh_validate(&mesh, NULL));
    return mesh;
}

static void embed_check_rigid(const sb_mesh *mesh, const sb_vec3 *points, int count, sb_embedding_kind kind,
                              double size)
{
    sb_embedding *embedding = embed_points(mesh, points, count, kind);
    sb_vec3 *x = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)mesh->node_count);
    sb_vec3 *out = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)count);
    sb_vec3 *expected = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)count);
    sb_vec3 shift = sb_v3_scale(REAL(size), sb_v3(REAL(0.3), REAL(-0.8), REAL(0.5)));
    CHECK_OK(sb_embedding_update(embedding, mesh->nodes, out, NULL, NULL));
    CHECK_NEAR(scene_distance(out, points, count) / size, 0, scene_tolerance(1e-12, 1000));
    embed_transform(mesh->nodes, mesh->node_count, embed_rotation(), shift, x);
    embed_transform(points, count, embed_rotation(), shift, expected);
    CHECK_OK(sb_embedding_update(embedding, x, out, NULL, NULL));
    CHECK_NEAR(scene_distance(out, expected, count) / size, 0, scene_tolerance(1e-12, 1000));
    sb_embedding_destroy(embedding);
    free(x);
    free(out);
    free(expected);
}

static void test_rigid(void)
{
    for (int t = 0; t < 5; t++)
        for (int s = 0; s < 3; s++) {
            enum { COUNT = 400 };
            double size = s == 0 ? 1e-3 : s == 1 ? 1 : 1e3;
            sb_mesh mesh = embed_block(embed_types[t], size);
            sb_vec3 *points = embed_cloud(&mesh, COUNT, 0.3);
            embed_check_rigid(&mesh, points, COUNT, SB_EMBED_SMOOTH, size);
            embed_check_rigid(&mesh, points, COUNT, SB_EMBED_PLAIN, size);
            free(points);
            sb_mesh_free(&mesh);
        }
}

/* Points around the ring, the first of them close to its axis. */
static sb_vec3 *embed_ring_cloud(const sb_mesh *mesh, int count)
{
    sb_vec3 *points = embed_cloud(mesh, count, 0.1);
    for (int i = 0; i < 20; i++)
        points[i] = sb_v3(REAL(0.01 * i), REAL(-0.01 - 0.002 * i), REAL(0.02 * i));
    return points;
}

/* Around a bend there are points of every kind, fallback ones too. */
static void test_rigid_fallback(void)
{
    for (int t = 0; t < 5; t++) {
        enum { COUNT = 400 };
        sb_mesh mesh = embed_ring(embed_types[t]);
        sb_vec3 *points = embed_ring_cloud(&mesh, COUNT);
        sb_embedding *embedding = embed_points(&mesh, points, COUNT, SB_EMBED_SMOOTH);
        sb_embedding_report report = sb_embedding_get_report(embedding);
        CHECK(report.frame > 0 && report.offset > 0 && report.inside > 0);
        CHECK_INT(report.frame + report.offset + report.inside + report.extrapolated, COUNT);
        sb_embedding_destroy(embedding);
        embed_check_rigid(&mesh, points, COUNT, SB_EMBED_SMOOTH, 1);
        free(points);
        sb_mesh_free(&mesh);
    }
}

/* The same places in millimetres, metres and kilometres. */
static void test_units(void)
{
    enum { COUNT = 300 };
    sb_embedded_point first[COUNT], place;
    for (int s = 0; s < 3; s++) {
        double size = s == 0 ? 1 : s == 1 ? 1e-3 : 1e3;
        sb_mesh mesh = embed_block(SB_TET10, size);
        sb_vec3 *points = embed_cloud(&mesh, COUNT, 0.3);
        sb_embedding *embedding = embed_points(&mesh, points, COUNT, SB_EMBED_SMOOTH);
        for (int i = 0; i < COUNT && embedding; i++) {
            CHECK_OK(sb_embedding_get_point(embedding, i, &place));
            if (s == 0)
                first[i] = place;
            CHECK_INT(place.hold, first[i].hold);
            CHECK_NEAR(place.distance / REAL(size), first[i].distance, scene_tolerance(1e-10, 2000));
        }
        sb_embedding_destroy(embedding);
        free(points);
        sb_mesh_free(&mesh);
    }
}

/* Affine motions are exact inside, and everywhere with the plain kind; so are the rows of the mapping. */
static void test_affine(void)
{
    sb_mat3 a = sb_m3_add(sb_m3_identity(), sb_m3_outer(sb_v3(REAL(0.4), REAL(-0.2), REAL(0.1)),
                                                        sb_v3(REAL(0.5), REAL(0.7), REAL(-0.3))));
    for (int t = 0; t < 5; t++) {
        enum { COUNT = 300 };
        sb_mesh mesh = embed_block(embed_types[t], 1);
        sb_vec3 *points = embed_cloud(&mesh, COUNT, 0.2), out[COUNT], expected[COUNT], shift = sb_v3(1, 2, 3);
        sb_vec3 *x = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)mesh.node_count);
        sb_embedding *plain = embed_points(&mesh, points, COUNT, SB_EMBED_PLAIN);
        sb_embedding *smooth = embed_points(&mesh, points, COUNT, SB_EMBED_SMOOTH);
        sb_embedding_rows rows;
        embed_transform(mesh.nodes, mesh.node_count, a, shift, x);
        embed_transform(points, COUNT, a, shift, expected);
        CHECK_OK(sb_embedding_update(plain, x, out, NULL, NULL));
        CHECK_NEAR(scene_distance(out, expected, COUNT), 0, scene_tolerance(1e-13, 100));
        CHECK_OK(sb_embedding_mapping(smooth, NULL, &rows, NULL));
        CHECK_INT(rows.mapping.row_count, COUNT);
        CHECK_OK(sb_embedding_update(smooth, x, out, NULL, NULL));
        for (int i = 0; i < COUNT; i++) {
            sb_vec3 row = sb_v3(0, 0, 0);
            sb_embedded_point place;
            double sum = 0;
            for (int k = rows.mapping.row_start[i]; k < rows.mapping.row_start[i + 1]; k++) {
                row = sb_v3_madd(row, rows.mapping.weights[k], x[rows.mapping.nodes[k]]);
                sum += (double)rows.mapping.weights[k];
            }
            CHECK_NEAR(sum, 1, scene_tolerance(1e-13, 50));
            CHECK_NEAR(sb_v3_norm(sb_v3_sub(row, expected[i])), 0, scene_tolerance(1e-13, 100));
            CHECK_OK(sb_embedding_get_point(smooth, i, &place));
            if (place.hold == SB_EMBEDDED_INSIDE)
                CHECK_NEAR(sb_v3_norm(sb_v3_sub(out[i], expected[i])), 0, scene_tolerance(1e-13, 100));
        }
        sb_embedding_rows_free(&rows);
        sb_embedding_rows_free(&rows);
        sb_embedding_destroy(plain);
        sb_embedding_destroy(smooth);
        free(points);
        free(x);
        sb_mesh_free(&mesh);
    }
}

/* A line of points above faces of a bent block moves as a smooth line: no jumps where it crosses edges. */
static void test_continuity(void)
{
    for (int t = 0; t < 5; t++) {
        enum { COUNT = 2000 };
        sb_mesh mesh = embed_block(embed_types[t], 1);
        sb_vec3 points[COUNT], out[COUNT];
        sb_vec3 *x = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)mesh.node_count);
        double longest = 0, spacing;
        sb_embedding *embedding;
        for (int i = 0; i < COUNT; i++) {
            double s = (double)i / (COUNT - 1);
            points[i] = sb_v3(REAL(0.01 + 0.18 * s), REAL(0.02 + 0.05 * s), REAL(0.105));
        }
        spacing = (double)sb_v3_norm(sb_v3_sub(points[1], points[0]));
        embed_bend(mesh.nodes, mesh.node_count, 0.2, x);
        embedding = embed_points(&mesh, points, COUNT, SB_EMBED_SMOOTH);
        CHECK_INT(sb_embedding_get_report(embedding).offset, COUNT);
        CHECK_OK(sb_embedding_update(embedding, x, out, NULL, NULL));
        for (int i = 1; i < COUNT; i++) {
            double d = (double)sb_v3_norm(sb_v3_sub(out[i], out[i - 1]));
            longest = d > longest ? d : longest;
        }
        CHECK(longest < (SB_REAL_IS_FLOAT ? 2.5 : 2) * spacing);
        sb_embedding_destroy(embedding);
        free(x);
        sb_mesh_free(&mesh);
    }
}

/* ---- normals ---- */

/* A grid of na x nb points over (a, b) in [0, 1]^2 as a surface, seen from the side of da x db. */
static sb_mesh embed_sheet(sb_element_type type, int na, int nb)
{
    sb_mesh sheet;
    int per = type == SB_QUAD4 ? 1 : 2, width = type == SB_QUAD4 ? 4 : 3;
    memset(&sheet, 0, sizeof sheet);
    sheet.element_type = type;
    sheet.node_count = na * nb;
    sheet.element_count = (na - 1) * (nb - 1) * per;
    sheet.nodes = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)sheet.node_count);
    sheet.elements = (int *)malloc(sizeof(int) * (size_t)width * (size_t)sheet.element_count);
    for (int j = 0, e = 0; j < nb; j++)
        for (int i = 0; i < na; i++) {
            int p = j * na + i, quad[4] = {p, p + 1, p + na + 1, p + na};
            sheet.nodes[p] = sb_v3(REAL(i) / REAL(na - 1), REAL(j) / REAL(nb - 1), 0);
            if (i == na - 1 || j == nb - 1)
                continue;
            if (type == SB_QUAD4) {
                memcpy(sheet.elements + 4 * e++, quad, sizeof quad);
            } else {
                int *tri = sheet.elements + 3 * e;
                tri[0] = quad[0], tri[1] = quad[1], tri[2] = quad[2];
                tri[3] = quad[0], tri[4] = quad[2], tri[5] = quad[3];
                e += 2;
            }
        }
    return sheet;
}

/* A beam of length 0.3 m bent to a quarter of a circle, its upper side drawn by a finer sheet that lies `above` it.
 * Returns the largest angle (degrees) between its normals and the circle's. carried: rest normals are given. */
static double embed_bent_beam_error(sb_element_type type, sb_element_type drawn, double above, int carried)
{
    const double length = 0.3, height = 0.03, curvature = 0.5 * 3.14159265358979 / length;
    sb_mesh mesh = scene_box(type, 12, 2, 2, sb_v3(REAL(length), REAL(0.04), REAL(height)), 0);
    sb_mesh sheet = embed_sheet(drawn, 121, 17);
    sb_embedding_def def = sb_default_embedding_def();
    sb_embedding *embedding;
    sb_vec3 *x = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)mesh.node_count), *rest, *out, *normals;
    double worst = 0;
    size_t bytes = sizeof(sb_vec3) * (size_t)sheet.node_count;
    rest = (sb_vec3 *)malloc(bytes);
    out = (sb_vec3 *)malloc(bytes);
    normals = (sb_vec3 *)malloc(bytes);
    for (int i = 0; i < sheet.node_count; i++) {
        sb_vec3 s = sheet.nodes[i];
        sheet.nodes[i] = sb_v3(REAL(length * (0.02 + 0.96 * (double)s.x)), REAL(0.04 * (0.1 + 0.8 * (double)s.y)),
                               REAL(height + above));
        rest[i] = sb_v3(0, 0, 5);
    }
    for (int i = 0; i < mesh.node_count; i++) {
        double angle = curvature * (double)mesh.nodes[i].x, radius = 1 / curvature + (double)mesh.nodes[i].z;
        x[i] = sb_v3(REAL(radius * sin(angle)), mesh.nodes[i].y, REAL(radius * cos(angle)));
    }
    def.mesh = &mesh;
    def.surface = &sheet;
    def.normals = carried ? rest : NULL;
    embedding = embed_make(&def);
    CHECK_OK(sb_embedding_update(embedding, x, out, normals, NULL));
    for (int i = 0; i < sheet.node_count; i++) {
        double angle = curvature * (double)sheet.nodes[i].x;
        sb_vec3 exact = sb_v3(REAL(sin(angle)), 0, REAL(cos(angle)));
        double sine = (double)sb_v3_norm(sb_v3_cross(exact, normals[i]));
        double error = 57.29577951 * atan2(sine, (double)sb_v3_dot(exact, normals[i]));
        worst = error > worst ? error : worst;
        CHECK_NEAR(sb_v3_norm(normals[i]), 1, scene_tolerance(1e-14, 8));
        CHECK_NEAR(out[i].x * out[i].x + out[i].z * out[i].z,
                   (1 / curvature + height + above) * (1 / curvature + height + above), 2e-4 * 0.05);
    }
    sb_embedding_destroy(embedding);
    sb_mesh_free(&mesh);
    sb_mesh_free(&sheet);
    free(x);
    free(rest);
    free(out);
    free(normals);
    return worst;
}

static void test_bent_beam_normals(void)
{
    for (int carried = 0; carried < 2; carried++)
        for (int k = 0; k < 3; k++) {
            double above = 0.002 * (k - 1);
            CHECK_NEAR(embed_bent_beam_error(SB_TET10, SB_TRI3, above, carried), 0, 1);
            CHECK_NEAR(embed_bent_beam_error(SB_HEX20, SB_QUAD4, above, carried), 0, 1);
            CHECK_NEAR(embed_bent_beam_error(SB_HEX27, SB_TRI3, above, carried), 0, 1);
        }
}

/* Normals of a flat open sheet, at its rim and corners too; of points without triangles; by rings in any order. */
static void test_open_surface(void)
{
    sb_mesh mesh = embed_block(SB_HEX8, 1);
    for (int t = 0; t < 2; t++) {
        sb_mesh sheet = embed_sheet(t ? SB_QUAD4 : SB_TRI3, 7, 5), shuffled = sheet;
        int width = t ? 4 : 3, count = sheet.node_count;
        sb_embedding_def def = sb_default_embedding_def();
        sb_embedding *embedding;
        sb_vec3 out[40], normals[40];
        sheet.node_count = shuffled.node_count = count + 1; /* one more, in no element */
        shuffled.nodes = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)(count + 1));
        for (int i = 0; i < count; i++)
            shuffled.nodes[i] = sb_v3(REAL(0.2) * sheet.nodes[i].x, REAL(0.1) * sheet.nodes[i].y, REAL(0.05));
        shuffled.nodes[count] = sb_v3(REAL(0.1), REAL(0.05), REAL(0.02));
        for (int e = 0; e < sheet.element_count / 2; e += 3) { /* rings no longer come in order */
            int other = sheet.element_count - 1 - e;
            for (int a = 0; a < width; a++) {
                int swap = sheet.elements[width * e + a];
                sheet.elements[width * e + a] = sheet.elements[width * other + a];
                sheet.elements[width * other + a] = swap;
            }
        }
        def.mesh = &mesh;
        def.surface = &shuffled;
        embedding = embed_make(&def);
        CHECK_OK(sb_embedding_update(embedding, mesh.nodes, out, normals, NULL));
        for (int i = 0; i < count; i++)
            CHECK_NEAR(sb_v3_norm(sb_v3_sub(normals[i], sb_v3(0, 0, 1))), 0, scene_tolerance(1e-13, 100));
        CHECK(sb_v3_norm(normals[count]) == 0);
        sb_embedding_destroy(embedding);
        free(shuffled.nodes);
        sb_mesh_free(&sheet);
    }
    sb_mesh_free(&mesh);
}

/* Carried normals are F^-T N: under an affine motion of points inside, and rigid ones of all. */
static void test_carried_normals(void)
{
    enum { COUNT = 300 };
    for (int t = 0; t < 5; t++) {
        sb_mesh mesh = embed_ring(embed_types[t]);
        sb_mat3 affine = sb_m3_add(sb_m3_identity(), sb_m3_outer(sb_v3(REAL(0.4), REAL(-0.2), REAL(0.1)),
                                                                 sb_v3(REAL(0.5), REAL(0.7), REAL(-0.3))));
        sb_vec3 *points = embed_ring_cloud(&mesh, COUNT), rest[COUNT], out[COUNT], normals[COUNT];
        sb_vec3 *x = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)mesh.node_count);
        sb_embedding_def def = sb_default_embedding_def();
        sb_embedding *embedding;
        unsigned long long seed = 9;
        for (int i = 0; i < COUNT; i++)
            rest[i] = sb_v3(REAL(check_random_in(&seed, -1, 1)), REAL(check_random_in(&seed, -1, 1)), REAL(0.3));
        def.mesh = &mesh;
        def.points = points;
        def.point_count = COUNT;
        def.normals = rest;
        embedding = embed_make(&def);
        for (int rigid = 0; rigid < 2; rigid++) {
            sb_mat3 a = rigid ? embed_rotation() : affine, turn = sb_m3_transpose(sb_m3_inverse(a));
            embed_transform(mesh.nodes, mesh.node_count, a, sb_v3(1, 0, 2), x);
            CHECK_OK(sb_embedding_update(embedding, x, out, normals, NULL));
            for (int i = 0; i < COUNT; i++) {
                sb_embedded_point place;
                sb_vec3 n = sb_m3_apply(turn, rest[i]);
                CHECK_OK(sb_embedding_get_point(embedding, i, &place));
                n = sb_v3_scale(1 / sb_v3_norm(n), n);
                if (rigid || place.hold == SB_EMBEDDED_INSIDE)
                    CHECK_NEAR(sb_v3_norm(sb_v3_sub(n, normals[i])), 0, scene_tolerance(2e-12, 5000));
            }
        }
        sb_embedding_destroy(embedding);
        free(points);
        free(x);
        sb_mesh_free(&mesh);
    }
}

/* ---- forces ---- */

/* What the tests of forces share: a bent ring with points of every kind. */
typedef struct embed_case {
    sb_mesh mesh;
    sb_embedding *embedding;
    sb_vec3 *points, *x, *forces, *node_forces;
} embed_case;

enum { EMBED_CASE_POINTS = 250 };

static embed_case embed_make_case(sb_element_type type, sb_embedding_kind kind)
{
    embed_case c;
    unsigned long long seed = 21;
    c.mesh = embed_ring(type);
    c.points = embed_ring_cloud(&c.mesh, EMBED_CASE_POINTS);
    c.embedding = embed_points(&c.mesh, c.points, EMBED_CASE_POINTS, kind);
    c.x = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)c.mesh.node_count);
    c.node_forces = (sb_vec3 *)calloc((size_t)c.mesh.node_count, sizeof(sb_vec3));
    c.forces = (sb_vec3 *)malloc(sizeof(sb_vec3) * EMBED_CASE_POINTS);
    for (int i = 0; i < EMBED_CASE_POINTS; i++)
        c.forces[i] = sb_v3(REAL(check_random_in(&seed, -1, 1)), REAL(check_random_in(&seed, -1, 1)),
                            REAL(check_random_in(&seed, -1, 1)));
    embed_bend(c.mesh.nodes, c.mesh.node_count, 1, c.x);
    return c;
}

static void embed_free_case(embed_case *c)
{
    sb_embedding_destroy(c->embedding);
    sb_mesh_free(&c->mesh);
    free(c->points);
    free(c->x);
    free(c->forces);
    free(c->node_forces);
}

/* f . dx = F . dv for central differences along a random direction. */
static void test_transpose(void)
{
    for (int t = 0; t < 10; t++) {
        embed_case c = embed_make_case(embed_types[t / 2], t % 2 ? SB_EMBED_PLAIN : SB_EMBED_SMOOTH);
        size_t nodes = (size_t)c.mesh.node_count;
        sb_vec3 *dx = (sb_vec3 *)malloc(sizeof(sb_vec3) * nodes), *moved = (sb_vec3 *)malloc(sizeof(sb_vec3) * nodes);
        sb_vec3 out[2][EMBED_CASE_POINTS];
        unsigned long long seed = 77;
        double step = SB_REAL_IS_FLOAT ? 1e-2 : 1e-5, work = 0, by_points = 0, size = 0;
        for (size_t i = 0; i < nodes; i++)
            dx[i] = sb_v3(REAL(check_random_in(&seed, -0.1, 0.1)), REAL(check_random_in(&seed, -0.1, 0.1)),
                          REAL(check_random_in(&seed, -0.1, 0.1)));
        CHECK_OK(sb_embedding_forces(c.embedding, c.x, c.forces, c.node_forces, NULL));
        for (size_t i = 0; i < nodes; i++)
            work += (double)sb_v3_dot(c.node_forces[i], dx[i]);
        for (int side = 0; side < 2; side++) {
            for (size_t i = 0; i < nodes; i++)
                moved[i] = sb_v3_madd(c.x[i], REAL(side ? step : -step), dx[i]);
            CHECK_OK(sb_embedding_update(c.embedding, moved, out[side], NULL, NULL));
        }
        for (int i = 0; i < EMBED_CASE_POINTS; i++) {
            double one = (double)sb_v3_dot(c.forces[i], sb_v3_sub(out[1][i], out[0][i])) / (2 * step);
            by_points += one;
            size += fabs(one);
        }
        CHECK_NEAR(work / size, by_points / size, SB_REAL_IS_FLOAT ? 1e-3 : 1e-8);
        embed_free_case(&c);
        free(dx);
        free(moved);
    }
}

static void test_balance(void)
{
    for (int t = 0; t < 10; t++) {
        embed_case c = embed_make_case(embed_types[t / 2], t % 2 ? SB_EMBED_PLAIN : SB_EMBED_SMOOTH);
        sb_vec3 out[EMBED_CASE_POINTS], force = sb_v3(0, 0, 0), moment = force;
        double size = 0, arm = 0;
        CHECK_OK(sb_embedding_update(c.embedding, c.x, out, NULL, NULL));
        CHECK_OK(sb_embedding_forces(c.embedding, c.x, c.forces, c.node_forces, NULL));
        for (int i = 0; i < EMBED_CASE_POINTS; i++) {
            force = sb_v3_sub(force, c.forces[i]);
            moment = sb_v3_sub(moment, sb_v3_cross(out[i], c.forces[i]));
        }
        for (int i = 0; i < c.mesh.node_count; i++) {
            force = sb_v3_add(force, c.node_forces[i]);
            moment = sb_v3_add(moment, sb_v3_cross(c.x[i], c.node_forces[i]));
            size += (double)sb_v3_norm(c.node_forces[i]);
            arm += (double)sb_v3_norm(c.x[i]) * (double)sb_v3_norm(c.node_forces[i]);
        }
        CHECK_NEAR(sb_v3_norm(force) / REAL(size), 0, scene_tolerance(1e-14, 20));
        CHECK_NEAR(sb_v3_norm(moment) / REAL(arm), 0, scene_tolerance(1e-14, 20));
        embed_free_case(&c);
    }
}

/* Forces are added to what is there, and to no node that has nothing to do with the points. */
static void test_forces_add(void)
{
    sb_mesh mesh = embed_block(SB_TET4, 1);
    sb_vec3 point = mesh.nodes[mesh.node_count - 1], inside = sb_v3(REAL(0.01), REAL(0.01), REAL(0.01));
    sb_vec3 force = sb_v3(1, 2, 3);
    sb_vec3 *forces = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)mesh.node_count), sum;
    sb_embedding *embedding = embed_points(&mesh, &point, 1, SB_EMBED_SMOOTH);
    CHECK_INT(sb_embedding_get_report(embedding).inside, 1);
    for (int i = 0; i < mesh.node_count; i++)
        forces[i] = sb_v3(7, 0, 0);
    CHECK_OK(sb_embedding_forces(embedding, mesh.nodes, &force, forces, NULL));
    CHECK_NEAR(forces[mesh.node_count - 1].x, 8, scene_tolerance(1e-13, 100));
    CHECK_NEAR(forces[mesh.node_count - 1].z, 3, scene_tolerance(1e-13, 100));
    sb_embedding_destroy(embedding);
    embedding = embed_points(&mesh, &inside, 1, SB_EMBED_SMOOTH);
    memset(forces, 0, sizeof(sb_vec3) * (size_t)mesh.node_count);
    CHECK_OK(sb_embedding_forces(embedding, mesh.nodes, &force, forces, NULL));
    sum = scene_sum(forces, mesh.node_count);
    CHECK_NEAR(sb_v3_norm(sb_v3_sub(sum, force)), 0, scene_tolerance(1e-14, 20));
    for (int i = 0, touched = 0; i < mesh.node_count; i++) {
        touched += sb_v3_norm(forces[i]) > 0;
        CHECK(touched <= 4);
    }
    sb_embedding_destroy(embedding);
    free(forces);
    sb_mesh_free(&mesh);
}

/* ---- threads, memory, failures ---- */

static unsigned long long embed_play(sb_element_type type, int workers)
{
    enum { COUNT = 5000 };
    sb_mesh mesh = embed_ring(type);
    sb_vec3 *points = embed_ring_cloud(&mesh, COUNT), *out = (sb_vec3 *)malloc(sizeof(sb_vec3) * COUNT);
    sb_vec3 *normals = (sb_vec3 *)malloc(sizeof(sb_vec3) * COUNT);
    sb_vec3 *x = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)mesh.node_count);
    sb_vec3 *forces = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof(sb_vec3));
    sb_embedding_def def = sb_default_embedding_def();
    sb_jobs jobs = scene_jobs(&workers);
    sb_embedding *embedding;
    unsigned long long hash;
    def.mesh = &mesh;
    def.points = points;
    def.point_count = COUNT;
    def.normals = points;
    if (workers > 1)
        def.jobs = jobs;
    embedding = embed_make(&def);
    embed_bend(mesh.nodes, mesh.node_count, 1, x);
    CHECK_OK(sb_embedding_update(embedding, x, out, normals, workers > 1 ? &jobs : NULL));
    CHECK_OK(sb_embedding_forces(embedding, x, normals, forces, workers > 1 ? &jobs : NULL));
    CHECK(scene_all_finite(out, COUNT) && scene_all_finite(normals, COUNT));
    hash = scene_hash(out, sizeof(sb_vec3) * COUNT) ^ scene_hash(normals, sizeof(sb_vec3) * COUNT) ^
           scene_hash(forces, sizeof(sb_vec3) * (size_t)mesh.node_count);
    sb_embedding_destroy(embedding);
    free(points);
    free(out);
    free(normals);
    free(x);
    free(forces);
    sb_mesh_free(&mesh);
    return hash;
}

static void test_threads(void)
{
    for (int t = 0; t < 3; t++) {
        unsigned long long alone = embed_play(embed_types[t], 1);
        CHECK(alone == embed_play(embed_types[t], 2));
        CHECK(alone == embed_play(embed_types[t], 3));
    }
}

static void test_memory(void)
{
    sb_mesh mesh = embed_ring(SB_TET10), sheet = embed_sheet(SB_TRI3, 20, 20);
    sb_embedding_def def = sb_default_embedding_def();
    sb_embedding *embedding = NULL;
    sb_embedding_rows rows;
    scene_memory memory = {0, 0, 0, 0};
    sb_vec3 out[400], normals[400];
    sb_vec3 *forces = (sb_vec3 *)calloc((size_t)mesh.node_count, sizeof(sb_vec3));
    int calls, before;
    sb_error error;
    for (int i = 0; i < sheet.node_count; i++)
        sheet.nodes[i] = sb_v3(REAL(2.2) * sheet.nodes[i].x - REAL(1.1), REAL(-1.2) * sheet.nodes[i].y, REAL(0.41));
    def.mesh = &mesh;
    def.surface = &sheet;
    def.allocator = scene_allocator(&memory);
    CHECK_OK(sb_embedding_create(&def, &embedding, &error));
    calls = before = memory.calls;
    CHECK_OK(sb_embedding_update(embedding, mesh.nodes, out, normals, NULL));
    CHECK_OK(sb_embedding_forces(embedding, mesh.nodes, normals, forces, NULL));
    CHECK_INT(memory.calls, before);
    for (int k = 1; k <= 3; k++) {
        memset(&rows, 0x55, sizeof rows);
        memory.fail_at = memory.calls + k;
        before = memory.live;
        CHECK_RESULT(sb_embedding_mapping(embedding, &def.allocator, &rows, &error), SB_ERROR_MEMORY);
        CHECK_INT(memory.live, before);
        CHECK_INT(((const unsigned char *)&rows)[0], 0x55);
    }
    sb_embedding_destroy(embedding);
    CHECK_INT(memory.live, 0);
    for (int k = 1; k <= calls; k++) {
        memory.calls = 0;
        memory.fail_at = k;
        embedding = NULL;
        CHECK_RESULT(sb_embedding_create(&def, &embedding, &error), SB_ERROR_MEMORY);
        CHECK(embedding == NULL);
        CHECK_INT(memory.live, 0);
    }
    free(forces);
    sb_mesh_free(&sheet);
    sb_mesh_free(&mesh);
}

/* The def is refused with this result, and nothing happens to the output. */
static sb_error embed_check_refused(const sb_embedding_def *def, sb_result result)
{
    sb_error error;
    sb_embedding *embedding = NULL;
    memset(&error, 0, sizeof error);
    CHECK_RESULT(sb_embedding_create(def, &embedding, &error), result);
    CHECK(embedding == NULL && error.result == result && error.message[0] != 0);
    return error;
}

static void test_bad_points(void)
{
    check_bad_numbers();
    sb_mesh mesh = embed_block(SB_TET4, 1);
    sb_vec3 points[3];
    sb_embedding_def def = sb_default_embedding_def();
    points[0] = points[1] = points[2] = sb_v3(REAL(0.1), REAL(0.05), REAL(0.05));
    def.mesh = &mesh;
    def.points = points;
    def.point_count = 3;
    def.normals = points;
    points[2].y = REAL(NAN);
    CHECK_INT(embed_check_refused(&def, SB_ERROR_NOT_FINITE).node, 2);
    points[2].y = REAL(INFINITY);
    CHECK_INT(embed_check_refused(&def, SB_ERROR_NOT_FINITE).node, 2);
    points[2] = sb_v3(REAL(0.1), REAL(0.05), REAL(0.3));
    def.max_distance = REAL(0.1);
    CHECK_INT(embed_check_refused(&def, SB_ERROR_ARGUMENT).node, 2);
    points[2] = sb_v3(SB_REAL_MAX / 2, 0, -SB_REAL_MAX / 2);
    def.max_distance = SB_REAL_MAX;
    CHECK_INT(embed_check_refused(&def, SB_ERROR_ARGUMENT).node, 2);
    def.max_distance = REAL(-1);
    embed_check_refused(&def, SB_ERROR_ARGUMENT);
    def.max_distance = REAL(NAN);
    embed_check_refused(&def, SB_ERROR_ARGUMENT);
    sb_mesh_free(&mesh);
}

static void test_bad_def(void)
{
    sb_mesh mesh = embed_block(SB_TET4, 1), sheet = embed_sheet(SB_TRI3, 3, 3), bad = mesh;
    sb_embedding_def def, good = sb_default_embedding_def();
    int unknown = 7;
    good.mesh = &mesh;
    good.surface = &sheet;
    memset(&def, 0, sizeof def);
    embed_check_refused(&def, SB_ERROR_ARGUMENT);
    embed_check_refused(NULL, SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_embedding_create(&good, NULL, NULL), SB_ERROR_ARGUMENT);
    def = good;
    def.mesh = NULL;
    embed_check_refused(&def, SB_ERROR_ARGUMENT);
    def = good;
    def.surface = NULL;
    embed_check_refused(&def, SB_ERROR_ARGUMENT);
    def = good;
    def.kind = (sb_embedding_kind)unknown;
    embed_check_refused(&def, SB_ERROR_ARGUMENT);
    def = good;
    def.points = sheet.nodes;
    def.point_count = 8;
    embed_check_refused(&def, SB_ERROR_ARGUMENT);
    def.surface = NULL;
    def.point_count = 0;
    embed_check_refused(&def, SB_ERROR_ARGUMENT);
    def = good;
    def.surface = &mesh;
    embed_check_refused(&def, SB_ERROR_ARGUMENT);
    def = good;
    def.mesh = &sheet;
    embed_check_refused(&def, SB_ERROR_ARGUMENT);
    def = good;
    bad.element_type = SB_CUSTOM;
    def.mesh = &bad;
    embed_check_refused(&def, SB_ERROR_UNSUPPORTED);
    def = good;
    sheet.elements[4] = 99;
    CHECK_INT(embed_check_refused(&def, SB_ERROR_INDEX).element, 1);
    sheet.elements[4] = 4;
    mesh.elements[5] = -1;
    embed_check_refused(&good, SB_ERROR_INDEX);
    mesh.elements[5] = mesh.elements[4];
    embed_check_refused(&good, SB_ERROR_MESH);
    sb_mesh_free(&mesh);
    sb_mesh_free(&sheet);
}

static void test_bad_calls(void)
{
    sb_mesh mesh = embed_block(SB_TET4, 1);
    sb_vec3 point = sb_v3(REAL(0.1), REAL(0.05), REAL(0.05)), out = sb_v3(1, 2, 3), normal = out, *x = mesh.nodes;
    sb_embedding *embedding = embed_points(&mesh, &point, 1, SB_EMBED_SMOOTH);
    sb_embedded_point place;
    sb_embedding_rows rows;
    CHECK_RESULT(sb_embedding_update(NULL, x, &out, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_embedding_update(embedding, NULL, &out, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_embedding_update(embedding, x, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_embedding_update(embedding, x, &out, &normal, NULL), SB_ERROR_ARGUMENT); /* no source of normals */
    CHECK(out.x == 1 && normal.x == 1);
    CHECK_RESULT(sb_embedding_forces(embedding, x, NULL, &out, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_embedding_forces(embedding, x, &point, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_embedding_forces(embedding, NULL, &point, x, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_embedding_get_point(embedding, 1, &place), SB_ERROR_INDEX);
    CHECK_RESULT(sb_embedding_get_point(embedding, -1, &place), SB_ERROR_INDEX);
    CHECK_RESULT(sb_embedding_get_point(embedding, 0, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_embedding_mapping(NULL, NULL, &rows, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_embedding_mapping(embedding, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_INT(sb_embedding_get_report(NULL).point_count, 0);
    sb_embedding_rows_free(NULL);
    sb_embedding_destroy(NULL);
    sb_embedding_destroy(embedding);
    sb_mesh_free(&mesh);
}

/* Positions collapsed to a point, or not finite, give no crash; the next frame is as if they had never been. */
static void test_degenerate_frames(void)
{
    check_bad_numbers();
    embed_case c = embed_make_case(SB_TET10, SB_EMBED_SMOOTH);
    sb_vec3 first[EMBED_CASE_POINTS], out[EMBED_CASE_POINTS];
    sb_vec3 *flat = (sb_vec3 *)calloc((size_t)c.mesh.node_count, sizeof(sb_vec3));
    CHECK_OK(sb_embedding_update(c.embedding, c.x, first, NULL, NULL));
    CHECK_OK(sb_embedding_update(c.embedding, flat, out, NULL, NULL));
    CHECK(scene_all_finite(out, EMBED_CASE_POINTS));
    CHECK_OK(sb_embedding_forces(c.embedding, flat, c.forces, c.node_forces, NULL));
    CHECK(scene_all_finite(c.node_forces, c.mesh.node_count));
    flat[3].x = REAL(NAN);
    CHECK_OK(sb_embedding_update(c.embedding, flat, out, NULL, NULL));
    CHECK_OK(sb_embedding_update(c.embedding, c.x, out, NULL, NULL));
    CHECK(memcmp(first, out, sizeof out) == 0);
    free(flat);
    embed_free_case(&c);
}

/* Landmarks of a body follow targets by the mapping. */
static void test_landmarks(void)
{
    sb_mesh mesh = embed_block(SB_TET10, 1);
    sb_body_def def = sb_default_body_def();
    sb_vec3 points[2], targets[2], held[2];
    sb_embedding *embedding;
    sb_embedding_rows rows;
    sb_body *body;
    sb_real stiffness = 50;
    int id = 0;
    points[0] = sb_v3(REAL(0.15), REAL(0.05), REAL(0.05));
    points[1] = sb_v3(REAL(0.17), REAL(0.03), REAL(0.08));
    embedding = embed_points(&mesh, points, 2, SB_EMBED_PLAIN);
    CHECK_OK(sb_embedding_mapping(embedding, NULL, &rows, NULL));
    def.mesh = &mesh;
    def.material = sb_material_corotated(5000, REAL(0.4), 1000);
    body = scene_body(&def);
    for (int i = 0; i < 2; i++)
        targets[i] = sb_v3_add(points[i], sb_v3(0, 0, REAL(0.01)));
    scene_fix_plane(body, &mesh, 0, 0, SB_XYZ);
    CHECK_OK(sb_body_add_mapping(body, &rows.mapping, &stiffness, 1, targets, &id, NULL));
    CHECK_OK(sb_body_step(body, REAL(0.01), NULL));
    CHECK_OK(sb_body_mapping_points(body, id, held));
    CHECK_OK(sb_embedding_update(embedding, sb_body_positions(body), points, NULL, NULL));
    CHECK_NEAR(scene_distance(points, held, 2), 0, scene_tolerance(1e-14, 10));
    CHECK(held[0].z > REAL(0.05));
    sb_embedding_rows_free(&rows);
    sb_embedding_destroy(embedding);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
}

/* The liver's segmented surface on its tet10 mesh. */
static void test_liver(void)
{
    char path[2][1024];
    sb_mesh mesh, surface;
    sb_embedding_def def = sb_default_embedding_def();
    sb_embedding *embedding;
    sb_embedding_report report;
    memset(&mesh, 0, sizeof mesh);
    memset(&surface, 0, sizeof surface);
    if (!check_shared_path(path[0], sizeof path[0], "data/volumes/liver_a_tet10_3k.vtk") ||
        !check_shared_path(path[1], sizeof path[1], "data/surfaces/liver_a.vtk")) {
        CHECK_SKIP("no liver");
        return;
    }
    CHECK_OK(sb_mesh_load(&mesh, path[0], NULL, NULL));
    CHECK_OK(sb_mesh_load(&surface, path[1], NULL, NULL));
    def.mesh = &mesh;
    def.surface = &surface;
    embedding = embed_make(&def);
    report = sb_embedding_get_report(embedding);
    CHECK_INT(report.inside + report.offset + report.frame, surface.node_count);
    CHECK(report.frame * 100 <= surface.node_count); /* almost every vertex has its foot */
    CHECK(report.max_distance > 0 && report.max_distance < REAL(0.01));
    sb_embedding_destroy(embedding);
    embed_check_rigid(&mesh, surface.nodes, surface.node_count, SB_EMBED_SMOOTH, 0.2);
    sb_mesh_free(&mesh);
    sb_mesh_free(&surface);
}

CHECK_SUITE(embed, {"closest point by brute force", test_closest}, {"parameters come back", test_parameters},
            {"distances to a ball", test_ball}, {"rigid motions", test_rigid},
            {"rigid motions of fallback points", test_rigid_fallback}, {"any unit", test_units},
            {"affine motions and mapping", test_affine}, {"no jumps across edges", test_continuity},
            {"normals of a bent beam", test_bent_beam_normals}, {"normals of open surfaces", test_open_surface},
            {"carried normals", test_carried_normals}, {"transpose by differences", test_transpose},
            {"force and moment", test_balance}, {"forces are added", test_forces_add},
            {"same bits for any threads", test_threads}, {"memory", test_memory}, {"bad points", test_bad_points},
            {"bad defs", test_bad_def}, {"bad calls", test_bad_calls}, {"degenerate frames", test_degenerate_frames},
            {"landmarks pull a body", test_landmarks}, {"liver", test_liver});
