/* From a label image to a surface that bounds a solid, whatever its voxels, and to a mesh with regions. */
#include "softbody.h"

#include "check.h"
#include "scene.h"

#define REAL(x) ((sb_real)(x))

/* An image of `n` voxels along each axis, of edge 1 / n. */
static int make_image(int n, sb_image *image)
{
    memset(image, 0, sizeof *image);
    image->counts[0] = image->counts[1] = image->counts[2] = n;
    image->spacing = sb_v3(REAL(1.0 / n), REAL(1.0 / n), REAL(1.0 / n));
    image->direction = sb_m3_identity();
    image->labels = (int *)calloc((size_t)n * (size_t)n * (size_t)n, sizeof(int));
    return CHECK(image->labels != NULL);
}

static int *voxel(const sb_image *image, int i, int j, int k)
{
    return &image->labels[((size_t)k * (size_t)image->counts[1] + (size_t)j) * (size_t)image->counts[0] + (size_t)i];
}

static sb_vec3 centre_of(const sb_image *image, int i, int j, int k)
{
    sb_vec3 x = sb_v3(image->spacing.x * REAL(i), image->spacing.y * REAL(j), image->spacing.z * REAL(k));
    return sb_v3_add(image->origin, sb_m3_apply(image->direction, x));
}

typedef double (*solid)(double x, double y, double z); /* below 0 inside */

static void fill(sb_image *image, solid shape, int label)
{
    for (int k = 0; k < image->counts[2]; k++)
        for (int j = 0; j < image->counts[1]; j++)
            for (int i = 0; i < image->counts[0]; i++) {
                sb_vec3 x = centre_of(image, i, j, k);
                if (shape((double)x.x, (double)x.y, (double)x.z) < 0)
                    *voxel(image, i, j, k) = label;
            }
}

static double ball(double x, double y, double z)
{
    x -= 0.47, y -= 0.51, z -= 0.49;
    return sqrt(x * x + y * y + z * z) - 0.3;
}

static double torus(double x, double y, double z)
{
    double ring = hypot(x - 0.5, y - 0.48) - 0.3;
    return hypot(ring, z - 0.49) - 0.1;
}

/* The surface of labels, which must be sound; all centres of voxels on their side of it. */
static int make_surface(const sb_label_def *def, sb_mesh *mesh, sb_label_report *report)
{
    const sb_image *image = def->image;
    sb_surface_report found;
    sb_surface *surface = NULL;
    sb_error error;
    int wrong = 0;
    if (!CHECK_OK(sb_image_surface(def, mesh, report, &error)) ||
        !CHECK_OK(sb_surface_check(mesh, NULL, &found, &error)))
        return 0;
    CHECK_INT(found.findings & ~SB_SURFACE_SEVERAL_PARTS, 0);
    CHECK_NEAR(found.volume / report->volume, 1, 1e-4);
    if (!CHECK_OK(sb_surface_create(mesh, NULL, &surface, &error)))
        return 0;
    for (int k = 0; k < image->counts[2]; k++)
        for (int j = 0; j < image->counts[1]; j++)
            for (int i = 0; i < image->counts[0]; i++) {
                int label = *voxel(image, i, j, k), inside = def->label_count == 0 && label != 0;
                for (int l = 0; l < def->label_count; l++)
                    inside |= label == def->labels[l];
                wrong += sb_surface_inside(surface, centre_of(image, i, j, k)) != inside;
            }
    CHECK_INT(wrong, 0);
    sb_surface_destroy(surface);
    return 1;
}

/* Angle (degrees) between the surface's normal and that of the ball, root mean square over the area. */
static double roughness(const sb_mesh *mesh)
{
    double sum = 0, whole = 0;
    for (int e = 0; e < mesh->element_count; e++) {
        const int *c = mesh->elements + 3 * e;
        sb_vec3 a = mesh->nodes[c[0]], b = mesh->nodes[c[1]], d = mesh->nodes[c[2]], out;
        sb_vec3 n = sb_v3_cross(sb_v3_sub(b, a), sb_v3_sub(d, a));
        double area = (double)sb_v3_norm(n), angle;
        out = sb_v3_sub(sb_v3_scale(REAL(1.0 / 3), sb_v3_add(a, sb_v3_add(b, d))),
                        sb_v3(REAL(0.47), REAL(0.51), REAL(0.49)));
        angle = acos(fmin(1, (double)sb_v3_dot(n, out) / (area * (double)sb_v3_norm(out))));
        sum += area * angle * angle;
        whole += area;
    }
    return sqrt(sum / whole) * 180 / 3.14159265358979;
}

/* Distances to the true ball in voxels, volume and steps. */
static void test_ball(void)
{
    const double volume = 4.0 / 3 * 3.14159265358979 * 0.027;
    sb_image image;
    double angles[3] = {0, 0, 0};
    if (!make_image(32, &image))
        return;
    fill(&image, ball, 5);
    for (int n = 0; n < 3; n++) {
        sb_label_def def = sb_default_label_def();
        sb_label_report report;
        sb_mesh mesh;
        double farthest = 0;
        def.image = &image;
        def.smoothing = 2 * n;
        if (!make_surface(&def, &mesh, &report))
            break;
        CHECK_NEAR(report.volume / report.voxel_volume, 1, 2e-4);
        CHECK_NEAR((double)report.volume / volume, 1, 5e-3);
        for (int i = 0; i < mesh.node_count; i++) {
            sb_vec3 x = mesh.nodes[i];
            farthest = fmax(farthest, fabs(ball((double)x.x, (double)x.y, (double)x.z)) * 32);
        }
        CHECK(farthest < 0.5); /* voxels */
        angles[n] = roughness(&mesh);
        sb_mesh_free(&mesh);
    }
    CHECK(angles[0] > 15 && angles[1] < 10 && angles[2] < 10); /* the steps are gone */
    sb_image_free(&image);
}

static void test_torus(void)
{
    const double volume = 2 * 3.14159265358979 * 3.14159265358979 * 0.3 * 0.01;
    sb_image image;
    sb_label_def def = sb_default_label_def();
    sb_label_report report;
    sb_mesh mesh;
    if (!make_image(40, &image))
        return;
    fill(&image, torus, 1);
    def.image = &image;
    if (make_surface(&def, &mesh, &report)) {
        CHECK_NEAR(report.volume / report.voxel_volume, 1, 2e-4);
        CHECK_NEAR((double)report.volume / volume, 1, 1e-2);
        sb_mesh_free(&mesh);
    }
    sb_image_free(&image);
}

/* Voxels of 1 by 1 by 3, turned, mirrored and moved: the surface goes along, and looks outward all the same. */
static void test_anisotropic(void)
{
    sb_image image;
    sb_real turn[3] = {REAL(0.36), REAL(0.48), REAL(-0.8)};
    for (int mirrored = 0; mirrored < 2; mirrored++) {
        sb_label_def def = sb_default_label_def();
        sb_label_report report;
        sb_mesh mesh, plain;
        double farthest = 0;
        if (!make_image(24, &image))
            return;
        image.spacing.z *= 3;
        for (int k = 0; k < 24; k++)
            for (int j = 0; j < 24; j++)
                for (int i = 0; i < 24; i++)
                    *voxel(&image, i, j, k) = hypot(hypot(i - 11.2, j - 12.1), 3 * (k - 12)) < 10;
        def.image = &image;
        if (!make_surface(&def, &plain, &report))
            break;
        image.origin = sb_v3(10, -20, 30);
        image.direction = sb_m3_columns(sb_v3(turn[0], turn[1], turn[2]), sb_v3(REAL(-0.8), REAL(0.6), 0),
                                        sb_v3(REAL(0.48), REAL(0.64), REAL(0.6)));
        if (mirrored)
            for (int r = 0; r < 3; r++)
                image.direction.m[r][1] *= -1;
        if (make_surface(&def, &mesh, &report)) {
            double radius = 10.0 / 24;
            CHECK_NEAR(report.volume / report.voxel_volume, 1, 1e-3);
            CHECK_NEAR((double)report.volume / (4.0 / 3 * 3.14159265358979 * radius * radius * radius), 1, 0.03);
            CHECK_INT(mesh.node_count, plain.node_count);
            for (int i = 0; i < mesh.node_count && i < plain.node_count; i++) {
                sb_vec3 x = sb_v3_add(image.origin, sb_m3_apply(image.direction, plain.nodes[i]));
                farthest = fmax(farthest, (double)sb_v3_norm(sb_v3_sub(x, mesh.nodes[i])));
            }
            CHECK(farthest < 1e3 * (double)SB_EPSILON * 30); /* m, 30 m from 0 */
            sb_mesh_free(&mesh);
        }
        sb_mesh_free(&plain);
        sb_image_free(&image);
    }
}

/* Each shape alone and both together; the face between them is that of both. */
static void test_touching_labels(void)
{
    sb_image image;
    double volumes[3] = {0, 0, 0};
    if (!make_image(16, &image))
        return;
    for (int k = 4; k < 12; k++)
        for (int j = 4; j < 12; j++)
            for (int i = 3; i < 13; i++)
                *voxel(&image, i, j, k) = i < 8 ? 3 : -7;
    for (int n = 0; n < 3; n++) {
        static const int labels[2] = {3, -7};
        sb_label_def def = sb_default_label_def();
        sb_label_report report;
        sb_mesh mesh;
        def.image = &image;
        def.labels = n == 1 ? labels + 1 : labels;
        def.label_count = n == 2 ? 2 : 1;
        if (!make_surface(&def, &mesh, &report))
            break;
        CHECK_INT(report.voxels, n == 2 ? 640 : 320);
        CHECK_NEAR(report.volume / report.voxel_volume, 1, 1e-3);
        volumes[n] = (double)report.volume;
        sb_mesh_free(&mesh);
    }
    CHECK_NEAR(volumes[0] + volumes[1], volumes[2], 2e-3 * volumes[2]);
    sb_image_free(&image);
}

/* What is one voxel thick is lost by no smoothing. */
static void test_plates(void)
{
    for (int smoothing = 0; smoothing <= SB_LABEL_MAX_SMOOTHING; smoothing += 2)
        for (int thick = 1; thick <= 3; thick++) {
            sb_image image;
            sb_label_def def = sb_default_label_def();
            sb_label_report report;
            sb_mesh mesh;
            if (!make_image(20, &image))
                return;
            for (int k = 9; k < 9 + thick; k++)
                for (int j = 3; j < 17; j++)
                    for (int i = 3; i < 17; i++)
                        *voxel(&image, i, j, k) = 1;
            def.image = &image;
            def.smoothing = smoothing;
            if (make_surface(&def, &mesh, &report)) {
                CHECK(report.volume > REAL(0.9) * report.voxel_volume &&
                      report.volume < REAL(1.1) * report.voxel_volume);
                CHECK(smoothing > 2 || fabs((double)(report.volume / report.voxel_volume) - 1) < 2e-3);
                sb_mesh_free(&mesh);
            }
            sb_image_free(&image);
        }
}

/* Labels up to the border of the image, and all of it. */
static void test_border(void)
{
    sb_image image;
    for (int n = 0; n < 2; n++) {
        sb_label_def def = sb_default_label_def();
        sb_label_report report;
        sb_mesh mesh;
        sb_vec3 low, high;
        if (!make_image(8, &image))
            return;
        for (int i = 0; i < 512; i++)
            image.labels[i] = n || i % 8 < 4;
        def.image = &image;
        if (make_surface(&def, &mesh, &report)) {
            CHECK_NEAR(report.volume / report.voxel_volume, 1, 1e-3);
            sb_mesh_bounds(&mesh, &low, &high);
            CHECK_NEAR(low.y, -0.5 / 8, 0.3 / 8);
            CHECK_NEAR(high.y, 7.5 / 8, 0.3 / 8);
            sb_mesh_free(&mesh);
        }
        sb_image_free(&image);
    }
}

/* All 256 cubes, then noise of every density: voxels that touch along edges and in corners in every way. */
static void test_ambiguous(void)
{
    unsigned long long random = 3;
    sb_image image;
    if (!make_image(4, &image))
        return;
    for (int trial = 1; trial < 256 + 120; trial++) {
        sb_label_def def = sb_default_label_def();
        sb_label_report report;
        sb_mesh mesh;
        for (int i = 0; i < 64; i++)
            image.labels[i] = trial >= 256 && check_random(&random) < 0.1 + 0.1 * (trial % 9);
        for (int c = 0; c < 8 && trial < 256; c++)
            *voxel(&image, 1 + (c & 1), 1 + (c >> 1 & 1), 1 + (c >> 2)) = trial >> c & 1;
        image.labels[0] |= trial >= 256; /* never empty */
        def.image = &image;
        def.smoothing = trial % 4;
        if (!make_surface(&def, &mesh, &report))
            break;
        sb_mesh_free(&mesh);
    }
    /* along an edge, in a corner: parts of their own */
    for (int n = 0; n < 2; n++) {
        sb_label_def def = sb_default_label_def();
        sb_surface_report found;
        sb_label_report report;
        sb_mesh mesh;
        memset(image.labels, 0, 64 * sizeof(int));
        *voxel(&image, 1, 1, 1) = *voxel(&image, 2, 2, n ? 2 : 1) = 1;
        def.image = &image;
        if (!make_surface(&def, &mesh, &report))
            break;
        CHECK_OK(sb_surface_check(&mesh, NULL, &found, NULL));
        CHECK_INT(found.parts, 2);
        sb_mesh_free(&mesh);
    }
    sb_image_free(&image);
}

/* A hollow ball: the wall of the cavity looks into it. */
static void test_cavity(void)
{
    sb_image image;
    sb_label_def def = sb_default_label_def();
    sb_label_report report;
    sb_mesh mesh;
    if (!make_image(24, &image))
        return;
    fill(&image, ball, 1);
    for (int k = 10; k < 14; k++)
        for (int j = 10; j < 14; j++)
            for (int i = 10; i < 14; i++)
                *voxel(&image, i, j, k) = 0;
    def.image = &image;
    if (make_surface(&def, &mesh, &report)) {
        CHECK_NEAR(report.volume / report.voxel_volume, 1, 1e-3);
        sb_mesh_free(&mesh);
    }
    sb_image_free(&image);
}

/* An organ with a tumour, as tets: its elements know which is which. */
static void test_regions(void)
{
    sb_image image;
    sb_label_def def = sb_default_label_def();
    sb_stuff_def stuff = sb_default_stuff_def();
    sb_shape shape;
    sb_label_report report;
    sb_mesh mesh, tets;
    sb_surface *surface = NULL;
    sb_error error;
    double volumes[3] = {0, 0, 0}, voxels[3] = {0, 0, 0};
    if (!make_image(32, &image))
        return;
    fill(&image, ball, 1);
    for (int k = 12; k < 20; k++)
        for (int j = 12; j < 20; j++)
            for (int i = 10; i < 18; i++)
                *voxel(&image, i, j, k) = 2;
    for (int i = 0; i < 32 * 32 * 32; i++)
        voxels[image.labels[i]] += 1.0 / (32 * 32 * 32);
    def.image = &image;
    memset(&shape, 0, sizeof shape);
    memset(&tets, 0, sizeof tets);
    if (make_surface(&def, &mesh, &report) && CHECK_OK(sb_surface_create(&mesh, NULL, &surface, &error))) {
        shape.surface = surface;
        stuff.shapes = &shape;
        stuff.shape_count = 1;
        stuff.cell = REAL(1.0 / 32);
        CHECK_OK(sb_mesh_stuff(&stuff, &tets, NULL, &error));
        CHECK_OK(sb_image_set_regions(&image, &tets, &error));
        for (int e = 0; e < tets.element_count; e++) {
            const int *n = tets.elements + 4 * e;
            sb_vec3 a = sb_v3_sub(tets.nodes[n[1]], tets.nodes[n[0]]),
                    b = sb_v3_sub(tets.nodes[n[2]], tets.nodes[n[0]]);
            volumes[tets.regions[e]] +=
                (double)sb_v3_dot(sb_v3_cross(a, b), sb_v3_sub(tets.nodes[n[3]], tets.nodes[n[0]])) / 6;
        }
        CHECK_NEAR(volumes[0], 0, 0); /* at the skin, too */
        CHECK_NEAR(volumes[1] / voxels[1], 1, 0.03);
        CHECK_NEAR(volumes[2] / voxels[2], 1, 0.08);
        sb_mesh_free(&mesh);
    }
    sb_surface_destroy(surface);
    sb_mesh_free(&tets);
    sb_image_free(&image);
}

static void test_failures(void)
{
    static const int no_labels[1] = {9};
    sb_image image;
    sb_label_def def = sb_default_label_def(), bad;
    sb_label_report report;
    sb_mesh mesh, tets;
    sb_result result = SB_ERROR_MEMORY;
    sb_error error;
    if (!make_image(8, &image))
        return;
    def.image = &image;
    memset(&mesh, 0, sizeof mesh);
    CHECK_RESULT(sb_image_surface(&def, &mesh, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK(strstr(error.message, "label other than 0") != NULL);
    fill(&image, ball, 1);
    bad = def, bad.labels = no_labels, bad.label_count = 1;
    CHECK_RESULT(sb_image_surface(&bad, &mesh, NULL, &error), SB_ERROR_ARGUMENT);
    bad = def, bad.smoothing = SB_LABEL_MAX_SMOOTHING + 1;
    CHECK_RESULT(sb_image_surface(&bad, &mesh, NULL, &error), SB_ERROR_ARGUMENT);
    bad = def, bad.label_count = 1;
    CHECK_RESULT(sb_image_surface(&bad, &mesh, NULL, &error), SB_ERROR_ARGUMENT);
    bad = def, bad.cookie = 0;
    CHECK_RESULT(sb_image_surface(&bad, &mesh, NULL, &error), SB_ERROR_ARGUMENT);
    CHECK(mesh.nodes == NULL);
    for (int fail_at = 1; result != SB_OK && fail_at < 20; fail_at++) {
        scene_memory memory;
        memset(&memory, 0, sizeof memory);
        memory.fail_at = fail_at;
        def.allocator = scene_allocator(&memory);
        result = sb_image_surface(&def, &mesh, &report, &error);
        if (result == SB_OK)
            sb_mesh_free(&mesh);
        else
            CHECK(result == SB_ERROR_MEMORY && mesh.nodes == NULL);
        CHECK_INT(memory.live, 0);
    }
    CHECK_RESULT(result, SB_OK);
    if (CHECK_OK(sb_mesh_organ(SB_TET4, 4, NULL, &tets, NULL))) {
        scene_memory memory;
        sb_allocator own = tets.allocator;
        memset(&memory, 0, sizeof memory);
        memory.fail_at = 1;
        tets.allocator = scene_allocator(&memory);
        free(tets.regions);
        tets.regions = NULL;
        CHECK_RESULT(sb_image_set_regions(&image, &tets, NULL), SB_ERROR_MEMORY);
        CHECK(tets.regions == NULL);
        tets.allocator = own;
        sb_mesh_free(&tets);
    }
    sb_image_free(&image);
}

CHECK_SUITE(labels, {"a ball", test_ball}, {"a torus", test_torus}, {"anisotropic and turned", test_anisotropic},
            {"labels that touch", test_touching_labels}, {"plates of few voxels", test_plates},
            {"labels at the border", test_border}, {"ambiguous voxels", test_ambiguous}, {"a cavity", test_cavity},
            {"regions of a mesh", test_regions}, {"failures", test_failures});
