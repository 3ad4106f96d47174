/* mesh: checks, repairs, topology and geometry, on good, bad and hostile meshes. */
#include "softbody.h"

#include <limits.h>

#include "check.h"

#define MREAL(x) ((sb_real)(x))
static double mesh_eps(double factor) { return factor * (double)SB_EPSILON; }

/* ---- an allocator that counts, and fails on request ---- */

typedef struct mesh_memory {
    int live; /* blocks not released */
    int calls;
    int fail_at; /* call that returns NULL, or -1 */
} mesh_memory;

static void *mesh_memory_alloc(void *user, size_t bytes)
{
    mesh_memory *memory = (mesh_memory *)user;
    void *pointer = memory->calls++ == memory->fail_at ? NULL : malloc(bytes);
    memory->live += pointer != NULL;
    return pointer;
}
static void mesh_memory_release(void *user, void *pointer)
{
    ((mesh_memory *)user)->live -= pointer != NULL;
    free(pointer);
}
static sb_allocator mesh_counting(mesh_memory *memory)
{
    sb_allocator allocator;
    memory->live = memory->calls = 0;
    memory->fail_at = -1;
    allocator.alloc = mesh_memory_alloc;
    allocator.release = mesh_memory_release;
    allocator.user = memory;
    return allocator;
}

/* ---- meshes to test with ---- */

static sb_mesh mesh_none(void)
{
    sb_mesh mesh;
    memset(&mesh, 0, sizeof mesh);
    return mesh;
}

static sb_mesh mesh_beam(sb_element_type type, int nx, int ny, int nz)
{
    sb_mesh mesh = mesh_none();
    CHECK_OK(sb_mesh_beam(type, nx, ny, nz, sb_v3(MREAL(0.04), MREAL(0.03), MREAL(0.02)), NULL, &mesh, NULL));
    return mesh;
}

static int mesh_width(const sb_mesh *mesh) { return sb_element_node_count(mesh->element_type); }
static int *mesh_nodes_of(const sb_mesh *mesh, int e) { return mesh->elements + (size_t)e * (size_t)mesh_width(mesh); }

/* Adds malloc'ed regions that tell the elements apart. */
static void mesh_add_regions(sb_mesh *mesh)
{
    mesh->regions = (int *)malloc(sizeof(int) * (size_t)mesh->element_count);
    for (int e = 0; e < mesh->element_count; e++)
        mesh->regions[e] = e % 7;
}

/* The boundary of a mesh as a surface of its own. */
static sb_mesh mesh_skin(const sb_mesh *mesh)
{
    sb_boundary boundary;
    sb_mesh surface = mesh_none();
    if (CHECK_OK(sb_mesh_boundary(mesh, 1, NULL, &boundary, NULL))) {
        CHECK_OK(sb_mesh_copy(&boundary.surface, NULL, &surface, NULL));
        sb_boundary_free(&boundary);
    }
    return surface;
}

static sb_mesh_report mesh_report(const sb_mesh *mesh)
{
    sb_mesh_report report;
    memset(&report, 0, sizeof report);
    CHECK_OK(sb_mesh_check(mesh, NULL, &report, NULL));
    return report;
}

/* Moves every node (all of the shapes are quadratic in space) by a map of determinant 1. */
static void mesh_bend(sb_mesh *mesh)
{
    for (int v = 0; v < mesh->node_count; v++) {
        sb_vec3 *x = &mesh->nodes[v];
        x->x += 4 * x->y * x->y;
        x->z += 5 * x->y * x->y;
    }
}

static const sb_element_type mesh_volume_types[] = {SB_TET4, SB_TET10, SB_HEX8, SB_HEX20, SB_HEX27};
enum { MESH_VOLUMES = 5 };

static int mesh_is_quadratic(sb_element_type type)
{
    return sb_element_node_count(type) > sb_element_corner_count(type);
}
static int mesh_is_hex(sb_element_type type) { return sb_element_corner_count(type) == 8; }

/* ---- life ---- */

static void test_free_and_copy(void)
{
    mesh_memory memory;
    sb_allocator allocator = mesh_counting(&memory);
    sb_mesh mesh = mesh_beam(SB_TET10, 2, 1, 1), copy = mesh_none();
    sb_mesh_free(NULL);
    sb_mesh_free(&copy);
    mesh_add_regions(&mesh);
    CHECK_OK(sb_mesh_copy(&mesh, &allocator, &copy, NULL));
    CHECK_INT(memory.live, 3);
    CHECK_INT(copy.node_count, mesh.node_count);
    CHECK_INT(copy.element_type, SB_TET10);
    CHECK(memcmp(copy.nodes, mesh.nodes, sizeof(sb_vec3) * (size_t)mesh.node_count) == 0);
    CHECK(memcmp(copy.elements, mesh.elements, sizeof(int) * 10 * (size_t)mesh.element_count) == 0);
    CHECK(memcmp(copy.regions, mesh.regions, sizeof(int) * (size_t)mesh.element_count) == 0);
    sb_mesh_free(&copy);
    CHECK_INT(memory.live, 0);
    CHECK(copy.nodes == NULL && copy.node_count == 0);
    sb_mesh_free(&copy);
    CHECK_RESULT(sb_mesh_copy(&mesh, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_copy(NULL, NULL, &copy, NULL), SB_ERROR_ARGUMENT);
    sb_mesh_free(&mesh);
}

/* ---- validation ---- */

static void test_validate_counts(void)
{
    sb_error error;
    sb_mesh mesh = mesh_beam(SB_TET4, 1, 1, 1), broken;
    CHECK_OK(sb_mesh_validate(&mesh, &error));
    CHECK_RESULT(sb_mesh_validate(NULL, &error), SB_ERROR_ARGUMENT);
    broken = mesh, broken.node_count = -1;
    CHECK_RESULT(sb_mesh_validate(&broken, &error), SB_ERROR_ARGUMENT);
    broken = mesh, broken.element_count = INT_MIN;
    CHECK_RESULT(sb_mesh_validate(&broken, &error), SB_ERROR_ARGUMENT);
    broken = mesh, broken.nodes = NULL;
    CHECK_RESULT(sb_mesh_validate(&broken, &error), SB_ERROR_ARGUMENT);
    broken = mesh, broken.elements = NULL;
    CHECK_RESULT(sb_mesh_validate(&broken, &error), SB_ERROR_ARGUMENT);
    broken = mesh, broken.element_type = SB_NO_ELEMENT;
    CHECK_RESULT(sb_mesh_validate(&broken, &error), SB_ERROR_ARGUMENT);
    broken = mesh, broken.element_count = 0;
    CHECK_RESULT(sb_mesh_validate(&broken, &error), SB_ERROR_MESH);
    broken = mesh_none(), broken.element_type = SB_TET4;
    CHECK_RESULT(sb_mesh_validate(&broken, &error), SB_ERROR_MESH);
    CHECK_RESULT(sb_mesh_validate(&broken, NULL), SB_ERROR_MESH);
    sb_mesh_free(&mesh);
}

static void test_validate_nodes_and_indices(void)
{
    static const int bad[] = {-1, INT_MIN, INT_MAX, 0 /* becomes node_count */};
    sb_error error;
    volatile sb_real zero = 0;
    sb_mesh mesh = mesh_beam(SB_TET4, 2, 2, 2);
    for (int i = 0; i < 4; i++) {
        int *index = &mesh_nodes_of(&mesh, 5)[i], keep = *index;
        *index = i == 3 ? mesh.node_count : bad[i];
        CHECK_RESULT(sb_mesh_validate(&mesh, &error), SB_ERROR_INDEX);
        CHECK_INT(error.element, 5);
        *index = keep;
    }
    mesh_nodes_of(&mesh, 7)[1] = mesh_nodes_of(&mesh, 7)[3];
    CHECK_RESULT(sb_mesh_validate(&mesh, &error), SB_ERROR_MESH);
    CHECK_INT(error.element, 7);
    CHECK(strstr(error.message, "twice: 7") != NULL);
    check_bad_numbers();
    mesh.nodes[3].y = zero / zero;
    CHECK_RESULT(sb_mesh_validate(&mesh, &error), SB_ERROR_NOT_FINITE);
    CHECK_INT(error.node, 3);
    mesh.nodes[3].y = 1 / zero;
    CHECK_RESULT(sb_mesh_validate(&mesh, &error), SB_ERROR_NOT_FINITE);
    sb_mesh_free(&mesh);
}

static void mesh_swap_nodes(int *nodes, int a, int b)
{
    int keep = nodes[a];
    nodes[a] = nodes[b];
    nodes[b] = keep;
}

/* The message names the first elements and how many there are; the answer is the same at any scale of
 * length. */
static void test_validate_inverted(void)
{
    static const double scales[] = {1e-9, 1e-3, 1, 1e3, 1e9};
    sb_error error;
    for (int s = 0; s < 5; s++) {
        sb_mesh mesh = mesh_beam(SB_TET4, 3, 2, 2);
        CHECK_OK(sb_mesh_scale(&mesh, MREAL(scales[s]), NULL));
        CHECK_OK(sb_mesh_validate(&mesh, &error));
        mesh_swap_nodes(mesh_nodes_of(&mesh, 3), 0, 1);
        mesh_swap_nodes(mesh_nodes_of(&mesh, 17), 1, 2);
        mesh_swap_nodes(mesh_nodes_of(&mesh, 40), 2, 3);
        CHECK_RESULT(sb_mesh_validate(&mesh, &error), SB_ERROR_MESH);
        CHECK_INT(error.element, 3);
        CHECK(strstr(error.message, "3 elements") == error.message && strstr(error.message, "3, 17, 40") != NULL);
        for (int e = 50; e < 60; e++)
            mesh_swap_nodes(mesh_nodes_of(&mesh, e), 2, 3);
        CHECK_RESULT(sb_mesh_validate(&mesh, &error), SB_ERROR_MESH);
        CHECK(strstr(error.message, "13 elements") == error.message && strstr(error.message, "54, ...") != NULL);
        sb_mesh_free(&mesh);
    }
}

static void test_validate_flat(void)
{
    sb_error error;
    for (int t = 0; t < MESH_VOLUMES; t++) {
        sb_mesh mesh = mesh_beam(mesh_volume_types[t], 1, 1, 1);
        for (int v = 0; v < mesh.node_count; v++)
            mesh.nodes[v].z = MREAL(0.3) * mesh.nodes[v].x + MREAL(0.1) * mesh.nodes[v].y;
        CHECK_RESULT(sb_mesh_validate(&mesh, &error), SB_ERROR_MESH);
        CHECK(strstr(error.message, "flat") != NULL);
        sb_mesh_free(&mesh);
    }
}

static void test_validate_hex(void)
{
    sb_error error;
    sb_mesh mesh = mesh_beam(SB_HEX8, 2, 2, 2);
    mesh_swap_nodes(mesh_nodes_of(&mesh, 4), 6, 7); /* one face crossed over: some corners inverted */
    CHECK_RESULT(sb_mesh_validate(&mesh, &error), SB_ERROR_MESH);
    CHECK_INT(error.element, 4);
    sb_mesh_free(&mesh);
}

static void test_validate_midside(void)
{
    sb_error error;
    sb_mesh mesh = mesh_beam(SB_TET10, 2, 2, 2);
    mesh_bend(&mesh);
    CHECK_OK(sb_mesh_validate(&mesh, &error)); /* curved, but sound */
    for (int e = 0; e < mesh.element_count; e++)
        mesh_swap_nodes(mesh_nodes_of(&mesh, e), 8, 9); /* the order of gmsh */
    CHECK_RESULT(sb_mesh_validate(&mesh, &error), SB_ERROR_MESH);
    CHECK(strstr(error.message, "mid-edge") != NULL);
    for (int e = 0; e < mesh.element_count; e++)
        mesh_swap_nodes(mesh_nodes_of(&mesh, e), 8, 9);
    mesh.nodes[mesh_nodes_of(&mesh, 9)[5]].x += MREAL(0.02); /* as far as an edge is long */
    CHECK_RESULT(sb_mesh_validate(&mesh, &error), SB_ERROR_MESH);
    CHECK(strstr(error.message, "mid-edge") != NULL);
    sb_mesh_free(&mesh);
}

/* Quadratic hexes: a crossed face is inverted, a node out of place folds them; the centre's too. */
static void test_validate_quadratic_hex(void)
{
    for (int t = 3; t < MESH_VOLUMES; t++) {
        sb_mesh mesh = mesh_beam(mesh_volume_types[t], 2, 2, 2);
        int moved[] = {16, 18, mesh_width(&mesh) - 1}; /* two edges along z, and one or the centre */
        double straight = (double)sb_mesh_element_quality(&mesh, 3);
        sb_error error;
        CHECK_NEAR(straight, 1, mesh_eps(64));
        mesh_bend(&mesh);
        CHECK_OK(sb_mesh_validate(&mesh, &error)); /* curved, but sound */
        CHECK((double)sb_mesh_element_quality(&mesh, 3) < 0.99 && sb_mesh_element_quality(&mesh, 3) > 0);
        mesh_swap_nodes(mesh_nodes_of(&mesh, 4), 6, 7);
        CHECK_RESULT(sb_mesh_validate(&mesh, &error), SB_ERROR_MESH);
        CHECK_INT(error.element, 4);
        CHECK(strstr(error.message, "inverted") != NULL);
        mesh_swap_nodes(mesh_nodes_of(&mesh, 4), 6, 7);
        for (int i = 0; i < 3; i++) {
            sb_vec3 *x = &mesh.nodes[mesh_nodes_of(&mesh, 5)[moved[i]]], keep = *x;
            x->z += MREAL(0.008); /* cells are 0.01 high */
            CHECK_RESULT(sb_mesh_validate(&mesh, &error), SB_ERROR_MESH);
            CHECK(strstr(error.message, "mid-edge") != NULL);
            CHECK(sb_mesh_element_quality(&mesh, 5) <= 0);
            *x = keep;
        }
        CHECK_OK(sb_mesh_validate(&mesh, &error));
        sb_mesh_free(&mesh);
    }
}

static void test_validate_surface(void)
{
    sb_error error;
    sb_mesh volume = mesh_beam(SB_TET4, 2, 2, 2), mesh = mesh_skin(&volume);
    CHECK_OK(sb_mesh_validate(&mesh, &error));
    mesh_nodes_of(&mesh, 6)[0] = mesh_nodes_of(&mesh, 6)[1];
    CHECK_RESULT(sb_mesh_validate(&mesh, &error), SB_ERROR_MESH);
    CHECK_INT(error.element, 6);
    mesh_nodes_of(&mesh, 6)[0] = mesh.node_count;
    CHECK_RESULT(sb_mesh_validate(&mesh, &error), SB_ERROR_INDEX);
    sb_mesh_free(&mesh);
    sb_mesh_free(&volume);
}

/* ---- the report ---- */

static void test_report_sound(void)
{
    sb_mesh mesh = mesh_beam(SB_TET4, 4, 3, 2);
    sb_mesh_report report = mesh_report(&mesh);
    CHECK_INT(report.bad_count, 0);
    CHECK_INT(report.defect_count[SB_MESH_SOUND], 144);
    CHECK_INT(report.unreferenced_nodes, 0);
    CHECK_INT(report.first_unreferenced_node, -1);
    CHECK_INT(report.first_not_finite_node, -1);
    CHECK_INT(report.duplicate_nodes, 0);
    CHECK_INT(report.components, 1);
    CHECK_INT(report.boundary_faces, 2 * 2 * (12 + 8 + 6));
    CHECK_INT(report.nonmanifold_faces, 0);
    CHECK_NEAR(report.volume, 2.4e-5, 2.4e-5 * mesh_eps(64));
    CHECK_NEAR(report.min_edge, 0.01, mesh_eps(1));
    CHECK_NEAR(report.max_edge, 0.01 * sqrt(3.0), mesh_eps(1));
    CHECK_NEAR(report.worst_quality, 12 * pow(0.25, 1.0 / 3) / 10, mesh_eps(64)); /* V = h^3/6, edges 1 1 1 2 2 3 */
    CHECK(report.worst_element >= 0);
    sb_mesh_report_free(&report);
    CHECK(report.bad == NULL);
    sb_mesh_report_free(NULL);
    sb_mesh_free(&mesh);
}

/* One of each kind: the list is in the order of the elements, and each is counted once. */
static void test_report_lists_every_bad_element(void)
{
    static const sb_mesh_defect expected[] = {SB_MESH_INDEX_RANGE,   SB_MESH_NODE_NOT_FINITE,
                                              SB_MESH_REPEATED_NODE, SB_MESH_INVERTED,
                                              SB_MESH_FLAT,          SB_MESH_DUPLICATE};
    volatile sb_real zero = 0;
    sb_mesh mesh = mesh_beam(SB_TET4, 8, 1, 1);
    sb_mesh_report report;
    mesh_nodes_of(&mesh, 2)[2] = -3;
    mesh_nodes_of(&mesh, 6)[1] = mesh_nodes_of(&mesh, 6)[0];
    mesh_swap_nodes(mesh_nodes_of(&mesh, 9), 0, 1);
    for (int a = 0; a < 4; a++)
        mesh_nodes_of(&mesh, 12)[a] = a; /* four nodes in a row */
    memcpy(mesh_nodes_of(&mesh, 20), mesh_nodes_of(&mesh, 15), 4 * sizeof(int));
    check_bad_numbers();
    for (int e = 0; e < mesh.element_count; e++) /* nobody but element 4 uses the node that is not finite */
        for (int a = 0; a < 4; a++)
            if (mesh_nodes_of(&mesh, e)[a] == mesh.node_count - 1)
                mesh_nodes_of(&mesh, e)[a] = mesh_nodes_of(&mesh, 15)[a];
    mesh.nodes[mesh.node_count - 1].x = zero / zero;
    mesh_nodes_of(&mesh, 4)[0] = mesh.node_count - 1;
    report = mesh_report(&mesh);
    for (int d = 0, last = -1; d < 6; d++) {
        int at = -1;
        for (int i = 0; i < report.bad_count && at < 0; i++)
            if (report.bad[i].defect == expected[d] && report.bad[i].element <= 20)
                at = report.bad[i].element;
        CHECK(at > last && at <= 20);
        last = at;
    }
    for (int i = 1; i < report.bad_count; i++)
        CHECK(report.bad[i].element > report.bad[i - 1].element);
    CHECK_INT(report.defect_count[SB_MESH_INDEX_RANGE], 1);
    CHECK_INT(report.defect_count[SB_MESH_NODE_NOT_FINITE], 1);
    CHECK_INT(report.defect_count[SB_MESH_SOUND] + report.bad_count, mesh.element_count);
    CHECK_INT(report.not_finite_nodes, 1);
    CHECK_INT(report.first_not_finite_node, mesh.node_count - 1);
    CHECK(sb_is_finite(report.volume) && sb_is_finite(report.max_edge) && sb_is_finite(report.worst_quality));
    sb_mesh_report_free(&report);
    sb_mesh_free(&mesh);
}

/* ---- the files of shared/data/bad ---- */

/* Reads the nodes and elements of a legacy VTK or OBJ file into malloc'ed arrays without judging them. */
static int mesh_read(const char *path, sb_mesh *mesh)
{
    char word[128];
    int count = 0, width = 0, ok = 1;
    FILE *file = fopen(path, "r");
    *mesh = mesh_none();
    mesh->nodes = (sb_vec3 *)malloc(1000 * sizeof(sb_vec3));
    mesh->elements = (int *)malloc(10000 * sizeof(int));
    while (file && ok && fscanf(file, "%127s", word) == 1) {
        double x[3];
        char text[3][32];
        if (strcmp(word, "v") == 0) {
            ok = fscanf(file, "%31s %31s %31s", text[0], text[1], text[2]) == 3 && mesh->node_count < 1000;
            mesh->nodes[mesh->node_count++] =
                sb_v3(MREAL(strtod(text[0], NULL)), MREAL(strtod(text[1], NULL)), MREAL(strtod(text[2], NULL)));
            mesh->element_type = SB_TRI3;
        } else if (strcmp(word, "f") == 0) {
            int *f = mesh->elements + 3 * mesh->element_count++;
            ok = fscanf(file, "%d %d %d", &f[0], &f[1], &f[2]) == 3 && mesh->element_count < 3000;
            f[0]--, f[1]--, f[2]--;
        } else if (strcmp(word, "POINTS") == 0) {
            ok = fscanf(file, "%d %127s", &count, word) == 2 && count <= 1000;
            for (mesh->node_count = 0; ok && mesh->node_count < count; mesh->node_count++) {
                for (int k = 0; k < 3 && ok; k++) {
                    ok = fscanf(file, "%31s", text[k]) == 1;
                    x[k] = strtod(text[k], NULL);
                }
                mesh->nodes[mesh->node_count] = sb_v3(MREAL(x[0]), MREAL(x[1]), MREAL(x[2]));
            }
        } else if (strcmp(word, "CELLS") == 0) {
            ok = fscanf(file, "%d %*d", &count) == 1 && count <= 1000;
            for (mesh->element_count = 0; ok && mesh->element_count < count; mesh->element_count++) {
                ok = fscanf(file, "%d", &width) == 1 && width <= 10;
                for (int a = 0; ok && a < width; a++)
                    ok = fscanf(file, "%d", &mesh->elements[mesh->element_count * width + a]) == 1;
            }
            mesh->element_type = width == 4 ? SB_TET4 : (width == 10 ? SB_TET10 : SB_HEX8);
        }
    }
    if (file)
        fclose(file);
    return ok && file != NULL;
}

/* Reads a file of bad/ and checks it; 0 when the data are absent. */
static int mesh_check_file(const char *name, sb_mesh *mesh, sb_mesh_report *report, sb_result expected)
{
    char path[512], below[128];
    snprintf(below, sizeof below, "data/bad/%s", name);
    if (!check_shared_path(path, sizeof path, below)) {
        CHECK_SKIP("no shared data");
        return 0;
    }
    if (!CHECK(mesh_read(path, mesh)))
        printf("    file %s\n", name);
    *report = mesh_report(mesh);
    if (!CHECK_RESULT(sb_mesh_validate(mesh, NULL), expected))
        printf("    file %s\n", name);
    return 1;
}

static void mesh_drop(sb_mesh *mesh, sb_mesh_report *report)
{
    sb_mesh_report_free(report);
    sb_mesh_free(mesh);
}

typedef struct mesh_bad_file {
    const char *name;
    sb_result validate;
    sb_mesh_defect defect;
    int count, first; /* elements with that defect, and the first of them */
} mesh_bad_file;

static void test_bad_files_elements(void)
{
    static const mesh_bad_file files[] = {
        {"degenerate_triangle.obj", SB_ERROR_MESH, SB_MESH_REPEATED_NODE, 1, 5},
        {"face_index_out_of_range.obj", SB_ERROR_INDEX, SB_MESH_INDEX_RANGE, 1, 318},
        {"nan_coordinate.obj", SB_ERROR_NOT_FINITE, SB_MESH_NODE_NOT_FINITE, 5, -1},
        {"inf_coordinate.obj", SB_ERROR_NOT_FINITE, SB_MESH_NODE_NOT_FINITE, 5, -1},
        {"inverted_tets.vtk", SB_ERROR_MESH, SB_MESH_INVERTED, 3, 3},
        {"zero_volume_tet.vtk", SB_ERROR_MESH, SB_MESH_FLAT, 1, 72},
        {"duplicate_elements.vtk", SB_OK, SB_MESH_DUPLICATE, 5, -1},
        {"index_out_of_range.vtk", SB_ERROR_INDEX, SB_MESH_INDEX_RANGE, 1, 71},
        {"negative_index.vtk", SB_ERROR_INDEX, SB_MESH_INDEX_RANGE, 1, 71},
        {"repeated_node_in_tet.vtk", SB_ERROR_MESH, SB_MESH_REPEATED_NODE, 1, 71},
        {"nan_coordinate.vtk", SB_ERROR_NOT_FINITE, SB_MESH_NODE_NOT_FINITE, 2, -1},
        {"tet10_bad_midside.vtk", SB_ERROR_MESH, SB_MESH_BAD_MIDSIDE, 2, 20},
        {"tet10_gmsh_order.vtk", SB_ERROR_MESH, SB_MESH_BAD_MIDSIDE, 72, 0},
        {"hex8_inverted.vtk", SB_ERROR_MESH, SB_MESH_INVERTED, 1, 4},
        {"base_valid.vtk", SB_OK, SB_MESH_SOUND, 72, -1},
        {"tet10_base_valid.vtk", SB_OK, SB_MESH_SOUND, 72, -1},
    };
    for (size_t i = 0; i < sizeof files / sizeof files[0]; i++) {
        sb_mesh mesh;
        sb_mesh_report report;
        if (!mesh_check_file(files[i].name, &mesh, &report, files[i].validate))
            return;
        if (!CHECK_INT(report.defect_count[files[i].defect], files[i].count))
            printf("    file %s\n", files[i].name);
        if (files[i].defect != SB_MESH_SOUND)
            CHECK_INT(report.bad_count, files[i].count);
        if (files[i].first >= 0)
            CHECK_INT(report.bad[0].element, files[i].first);
        mesh_drop(&mesh, &report);
    }
}

static void test_bad_files_surfaces(void)
{
    sb_mesh mesh;
    sb_mesh_report report;
    int count = 0;
    if (!mesh_check_file("nonmanifold_edge_fin.obj", &mesh, &report, SB_OK))
        return;
    CHECK_INT(report.nonmanifold_edges, 1);
    CHECK_INT(report.open_edges, 2);
    mesh_drop(&mesh, &report);
    mesh_check_file("nonmanifold_vertex_bowtie.obj", &mesh, &report, SB_OK);
    CHECK_INT(report.nonmanifold_vertices, 1);
    CHECK_INT(report.open_edges + report.nonmanifold_edges, 0);
    mesh_drop(&mesh, &report);
    mesh_check_file("open_surface.obj", &mesh, &report, SB_OK);
    CHECK(report.open_edges > 0 && report.nonmanifold_edges == 0);
    mesh_drop(&mesh, &report);
    mesh_check_file("mixed_orientation.obj", &mesh, &report, SB_OK);
    CHECK(report.inconsistent_edges > 0);
    CHECK_OK(sb_mesh_orient_surface(&mesh, &count, NULL));
    CHECK_INT(count, (mesh.element_count + 6) / 7);
    CHECK_NEAR(sb_mesh_volume(&mesh), 5.05876e-4, 1e-9);
    mesh_drop(&mesh, &report);
    mesh_check_file("inside_out.obj", &mesh, &report, SB_OK);
    CHECK(report.volume < 0);
    CHECK_OK(sb_mesh_orient(&mesh, &count, NULL));
    CHECK_INT(count, mesh.element_count);
    CHECK(sb_mesh_volume(&mesh) > 0);
    mesh_drop(&mesh, &report);
    mesh_check_file("self_intersecting.obj", &mesh, &report, SB_OK);
    CHECK_INT(report.components, 2);
    mesh_drop(&mesh, &report);
}

static void test_bad_files_nodes(void)
{
    sb_mesh mesh;
    sb_mesh_report report;
    int count = 0;
    if (!mesh_check_file("duplicate_nodes.vtk", &mesh, &report, SB_OK))
        return;
    CHECK_INT(report.duplicate_nodes, 288 - 36);
    CHECK_INT(report.components, 72);
    CHECK_OK(sb_mesh_merge_nodes(&mesh, -1, &count, NULL));
    CHECK_INT(count, 288 - 36);
    CHECK_INT(mesh.node_count, 36);
    CHECK_NEAR(sb_mesh_volume(&mesh), 1.2e-5, 1e-5 * mesh_eps(16));
    mesh_drop(&mesh, &report);
    mesh_check_file("unreferenced_nodes.vtk", &mesh, &report, SB_OK);
    CHECK_INT(report.unreferenced_nodes, 2);
    CHECK_OK(sb_mesh_remove_unreferenced(&mesh, &count, NULL));
    CHECK_INT(count, 2);
    CHECK_INT(mesh.node_count, 36);
    CHECK_OK(sb_mesh_validate(&mesh, NULL));
    mesh_drop(&mesh, &report);
    mesh_check_file("two_components.vtk", &mesh, &report, SB_OK);
    CHECK_INT(report.components, 2);
    mesh_drop(&mesh, &report);
    mesh_check_file("duplicate_elements.vtk", &mesh, &report, SB_OK);
    CHECK_OK(sb_mesh_remove_duplicate_elements(&mesh, &count, NULL));
    CHECK_INT(count, 5);
    CHECK_INT(mesh.element_count, 72);
    mesh_drop(&mesh, &report);
}

/* ---- geometry ---- */

/* A quadratic map of determinant 1 keeps the volume of quadratic elements exactly, and of the surface around
 * them. */
static void volume_curved(sb_element_type type, sb_element_type face)
{
    sb_mesh mesh = mesh_beam(type, 3, 3, 2), surface;
    double total = 0;
    mesh_bend(&mesh);
    CHECK_OK(sb_mesh_validate(&mesh, NULL));
    CHECK_NEAR(sb_mesh_volume(&mesh), 2.4e-5, 2.4e-5 * mesh_eps(256));
    for (int e = 0; e < mesh.element_count; e++) {
        total += (double)sb_mesh_element_volume(&mesh, e);
        CHECK_NEAR(sb_mesh_element_volume(&mesh, e), 2.4e-5 / mesh.element_count, 1e-6 * mesh_eps(64));
    }
    CHECK_NEAR(total, 2.4e-5, 2.4e-5 * mesh_eps(256));
    surface = mesh_skin(&mesh);
    CHECK_INT(surface.element_type, face);
    CHECK_NEAR(sb_mesh_volume(&surface), 2.4e-5, 2.4e-5 * mesh_eps(1024));
    CHECK_INT(sb_mesh_element_volume(&surface, 0) == 0, 1);
    CHECK_INT(sb_mesh_element_volume(&mesh, -1) == 0, 1);
    CHECK_INT(sb_mesh_element_volume(&mesh, mesh.element_count) == 0, 1);
    sb_mesh_free(&surface);
    sb_mesh_free(&mesh);
}

static void test_volume_curved(void)
{
    volume_curved(SB_TET10, SB_TRI6);
    volume_curved(SB_HEX20, SB_QUAD8);
    volume_curved(SB_HEX27, SB_QUAD9);
}

static void test_volume_hex(void)
{
    sb_mesh mesh = mesh_beam(SB_HEX8, 3, 2, 2), surface;
    unsigned long long seed = 5;
    for (int v = 0; v < mesh.node_count; v++) { /* warped faces: volume = flux through bilinear boundary */
        mesh.nodes[v].x += MREAL(check_random_in(&seed, -1e-3, 1e-3));
        mesh.nodes[v].y += MREAL(check_random_in(&seed, -1e-3, 1e-3));
        mesh.nodes[v].z += MREAL(check_random_in(&seed, -1e-3, 1e-3));
    }
    surface = mesh_skin(&mesh);
    CHECK_INT(surface.element_type, SB_QUAD4);
    CHECK_NEAR(sb_mesh_volume(&surface), sb_mesh_volume(&mesh), 2.4e-5 * mesh_eps(256));
    sb_mesh_free(&surface);
    sb_mesh_free(&mesh);
}

static void test_area_and_bounds(void)
{
    for (int t = 0; t < MESH_VOLUMES; t++) {
        sb_mesh mesh = mesh_beam(mesh_volume_types[t], 4, 3, 2), surface = mesh_skin(&mesh);
        sb_vec3 low, high;
        sb_mesh_report report = mesh_report(&surface);
        CHECK_NEAR(sb_mesh_surface_area(&surface), 2 * (12e-4 + 8e-4 + 6e-4), 1e-2 * mesh_eps(64));
        CHECK_NEAR(report.area, 2 * (12e-4 + 8e-4 + 6e-4), 1e-2 * mesh_eps(64));
        CHECK_NEAR(report.volume, 2.4e-5, 2.4e-5 * mesh_eps(256));
        CHECK_INT(
            report.open_edges + report.nonmanifold_edges + report.inconsistent_edges + report.nonmanifold_vertices, 0);
        CHECK_INT(sb_mesh_surface_area(&mesh) == 0, 1);
        sb_mesh_bounds(&surface, &low, &high);
        CHECK(low.x == 0 && low.y == 0 && low.z == 0);
        CHECK(high.x == MREAL(0.04) && high.y == MREAL(0.03) && high.z == MREAL(0.02));
        sb_mesh_report_free(&report);
        sb_mesh_free(&surface);
        sb_mesh_free(&mesh);
    }
}

/* A mesh of one element with nodes x[count][3]. */
static sb_mesh mesh_single(sb_element_type type, const double (*x)[3])
{
    sb_mesh mesh = mesh_none();
    mesh.element_type = type;
    mesh.node_count = sb_element_node_count(type);
    mesh.element_count = 1;
    mesh.nodes = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)mesh.node_count);
    mesh.elements = (int *)malloc(sizeof(int) * (size_t)mesh.node_count);
    for (int a = 0; a < mesh.node_count; a++) {
        mesh.nodes[a] = sb_v3(MREAL(x[a][0]), MREAL(x[a][1]), MREAL(x[a][2]));
        mesh.elements[a] = a;
    }
    return mesh;
}

static void test_quality(void)
{
    static const double regular[4][3] = {{1, 1, 1}, {-1, 1, -1}, {1, -1, -1}, {-1, -1, 1}};
    static const double triangle[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    static const double rhombus[4][3] = {
        {0, 0, 0}, {1, 0, 0}, {1.5, 0.86602540378443865, 0}, {0.5, 0.86602540378443865, 0}};
    sb_mesh mesh = mesh_single(SB_TET4, regular), hex = mesh_beam(SB_HEX8, 1, 1, 1), tet10 = mesh_none();
    double straight;
    if (sb_mesh_element_volume(&mesh, 0) < 0)
        CHECK_OK(sb_mesh_orient(&mesh, NULL, NULL));
    CHECK_NEAR(sb_mesh_element_quality(&mesh, 0), 1, mesh_eps(16));
    mesh_swap_nodes(mesh.elements, 0, 1);
    CHECK_NEAR(sb_mesh_element_quality(&mesh, 0), -1, mesh_eps(16));
    CHECK_INT(sb_mesh_element_quality(&mesh, 1) == 0, 1);
    CHECK_INT(sb_mesh_element_quality(&mesh, -1) == 0, 1);
    CHECK_OK(sb_mesh_orient(&mesh, NULL, NULL));
    CHECK_OK(sb_mesh_to_tet10(&mesh, NULL, &tet10, NULL));
    straight = (double)sb_mesh_element_quality(&tet10, 0);
    CHECK_NEAR(straight, 1, mesh_eps(64));
    tet10.nodes[4].x += MREAL(0.2);
    CHECK((double)sb_mesh_element_quality(&tet10, 0) < 0.9 && sb_mesh_element_quality(&tet10, 0) > 0);
    CHECK_NEAR(sb_mesh_element_quality(&hex, 0), 1, mesh_eps(16));
    for (int v = 0; v < 8; v++)
        hex.nodes[v].x += hex.nodes[v].y; /* corners of 45 and 135 degrees */
    CHECK_NEAR(sb_mesh_element_quality(&hex, 0), sqrt(0.5), mesh_eps(64));
    sb_mesh_free(&mesh);
    sb_mesh_free(&tet10);
    sb_mesh_free(&hex);
    mesh = mesh_single(SB_TRI3, triangle);
    CHECK_NEAR(sb_mesh_element_quality(&mesh, 0), 1, mesh_eps(16));
    sb_mesh_free(&mesh);
    mesh = mesh_single(SB_QUAD4, rhombus);
    CHECK_NEAR(sb_mesh_element_quality(&mesh, 0), sqrt(0.75), mesh_eps(16));
    sb_mesh_free(&mesh);
}

/* ---- repairs ---- */

/* Mirrors element e without knowing how the library does it: exchanges nodes by the reflection r <-> s. */
static void mesh_mirror(sb_mesh *mesh, int e)
{
    int *nodes = mesh_nodes_of(mesh, e), old[SB_MAX_ELEMENT_NODES];
    sb_real at[3], other[3];
    memcpy(old, nodes, sizeof(int) * (size_t)mesh_width(mesh));
    for (int a = 0; a < mesh_width(mesh); a++)
        for (int b = 0; b < mesh_width(mesh); b++) {
            sb_element_node_point(mesh->element_type, a, at);
            sb_element_node_point(mesh->element_type, b, other);
            if (at[0] == other[1] && at[1] == other[0] && at[2] == other[2])
                nodes[a] = old[b];
        }
}

static void test_orient_volume(void)
{
    for (int t = 0; t < MESH_VOLUMES; t++) {
        sb_mesh mesh = mesh_beam(mesh_volume_types[t], 3, 2, 2);
        sb_error error;
        unsigned long long seed = 3;
        int mirrored = 0, flipped = -1;
        if (mesh_is_quadratic(mesh.element_type))
            mesh_bend(&mesh);
        for (int e = 0; e < mesh.element_count; e++) {
            if (check_random(&seed) < 0.4) {
                mesh_mirror(&mesh, e);
                mirrored++;
            }
        }
        CHECK_RESULT(sb_mesh_validate(&mesh, &error), SB_ERROR_MESH);
        CHECK_OK(sb_mesh_orient(&mesh, &flipped, NULL));
        CHECK_INT(flipped, mirrored);
        CHECK_OK(sb_mesh_validate(&mesh, &error));
        CHECK_NEAR(sb_mesh_volume(&mesh), 2.4e-5, 2.4e-5 * mesh_eps(256));
        CHECK_OK(sb_mesh_orient(&mesh, &flipped, NULL));
        CHECK_INT(flipped, 0);
        sb_mesh_free(&mesh);
    }
}

static void test_orient_surface(void)
{
    for (int t = 0; t < MESH_VOLUMES; t++) {
        sb_mesh volume = mesh_beam(mesh_volume_types[t], 4, 3, 3), mesh;
        unsigned long long seed = 4;
        int mirrored = 0, flipped = -1;
        sb_mesh_report report;
        if (mesh_is_quadratic(volume.element_type))
            mesh_bend(&volume);
        mesh = mesh_skin(&volume);
        for (int e = 0; e < mesh.element_count; e++) {
            if (check_random(&seed) < 0.7) { /* most: a majority would choose the wrong side */
                mesh_mirror(&mesh, e);
                mirrored++;
            }
        }
        CHECK_OK(sb_mesh_orient_surface(&mesh, &flipped, NULL));
        CHECK_INT(flipped, mirrored);
        CHECK_NEAR(sb_mesh_volume(&mesh), 2.4e-5, 2.4e-5 * mesh_eps(1024));
        report = mesh_report(&mesh);
        CHECK_INT(report.inconsistent_edges, 0);
        sb_mesh_report_free(&report);
        mirrored = 0;
        mesh.element_count -= 6; /* open now: the majority decides */
        for (int e = 0; e < mesh.element_count; e += 5) {
            mesh_mirror(&mesh, e);
            mirrored++;
        }
        CHECK_OK(sb_mesh_orient_surface(&mesh, &flipped, NULL));
        CHECK_INT(flipped, mirrored);
        CHECK_RESULT(sb_mesh_orient_surface(&volume, &flipped, NULL), SB_ERROR_ARGUMENT);
        CHECK_INT(flipped, mirrored);
        sb_mesh_free(&mesh);
        sb_mesh_free(&volume);
    }
}

/* A Moebius strip of quads has no orientation: the call fails and changes nothing. */
static void test_orient_one_sided(void)
{
    enum { STEPS = 12 };
    sb_vec3 nodes[2 * STEPS];
    int elements[4 * STEPS], before[4 * STEPS], flipped = 77;
    sb_mesh mesh = mesh_none();
    for (int i = 0; i < STEPS; i++) {
        double angle = 6.283185307179586 * i / (double)STEPS;
        for (int side = 0; side < 2; side++) {
            double r = 1 + (side ? 0.2 : -0.2) * cos(angle / 2);
            nodes[2 * i + side] =
                sb_v3(MREAL(r * cos(angle)), MREAL(r * sin(angle)), MREAL((side ? 0.2 : -0.2) * sin(angle / 2)));
        }
        elements[4 * i] = 2 * i;
        elements[4 * i + 1] = 2 * i + 1;
        elements[4 * i + 2] = i == STEPS - 1 ? 0 : 2 * i + 3; /* the last joins the first turned over */
        elements[4 * i + 3] = i == STEPS - 1 ? 1 : 2 * i + 2;
    }
    mesh.node_count = 2 * STEPS, mesh.nodes = nodes;
    mesh.element_count = STEPS, mesh.elements = elements, mesh.element_type = SB_QUAD4;
    memcpy(before, elements, sizeof before);
    CHECK_OK(sb_mesh_validate(&mesh, NULL));
    CHECK_RESULT(sb_mesh_orient(&mesh, &flipped, NULL), SB_ERROR_MESH);
    CHECK(memcmp(before, elements, sizeof before) == 0 && flipped == 77);
}

/* Gives every element nodes of its own. */
static sb_mesh mesh_explode(const sb_mesh *mesh)
{
    sb_mesh split = mesh_none();
    int indices = mesh->element_count * mesh_width(mesh);
    split.element_type = mesh->element_type;
    split.element_count = mesh->element_count;
    split.node_count = indices;
    split.nodes = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)indices);
    split.elements = (int *)malloc(sizeof(int) * (size_t)indices);
    for (int i = 0; i < indices; i++) {
        split.nodes[i] = mesh->nodes[mesh->elements[i]];
        split.elements[i] = i;
    }
    return split;
}

static void test_merge_nodes(void)
{
    static const double tolerances[] = {-1, 0, 1e-7, 4e-3};
    sb_mesh mesh = mesh_beam(SB_TET4, 4, 3, 2);
    for (int i = 0; i < 4; i++) {
        sb_mesh split = mesh_explode(&mesh);
        int merged = -1, nodes = split.node_count;
        CHECK_OK(sb_mesh_merge_nodes(&split, MREAL(tolerances[i]), &merged, NULL));
        CHECK_INT(merged, nodes - mesh.node_count);
        CHECK_INT(split.node_count, mesh.node_count);
        CHECK_OK(sb_mesh_validate(&split, NULL));
        for (int e = 0; e < mesh.element_count; e++)
            for (int a = 0; a < 4; a++) {
                sb_vec3 d = sb_v3_sub(split.nodes[mesh_nodes_of(&split, e)[a]], mesh.nodes[mesh_nodes_of(&mesh, e)[a]]);
                CHECK(d.x == 0 && d.y == 0 && d.z == 0);
            }
        CHECK_OK(sb_mesh_merge_nodes(&split, MREAL(tolerances[i]), &merged, NULL));
        CHECK_INT(merged, 0);
        sb_mesh_free(&split);
    }
    sb_mesh_free(&mesh);
}

/* Copies that differ a little, on both sides of a cell border of whatever grid, are found; and nothing
 * further. */
static void test_merge_tolerance(void)
{
    sb_mesh mesh = mesh_beam(SB_TET4, 4, 3, 2), split = mesh_explode(&mesh);
    unsigned long long seed = 8;
    int merged = -1, nodes = split.node_count;
    volatile sb_real zero = 0;
    for (int v = 0; v < nodes; v++) {
        split.nodes[v].x += MREAL(check_random_in(&seed, -4e-5, 4e-5));
        split.nodes[v].y += MREAL(check_random_in(&seed, -4e-5, 4e-5));
        split.nodes[v].z += MREAL(check_random_in(&seed, -4e-5, 4e-5));
    }
    CHECK_OK(sb_mesh_merge_nodes(&split, MREAL(1e-9), &merged, NULL));
    CHECK_INT(merged, 0);
    CHECK_OK(sb_mesh_merge_nodes(&split, MREAL(1.5e-4), &merged, NULL));
    CHECK_INT(merged, nodes - mesh.node_count);
    check_bad_numbers();
    CHECK_RESULT(sb_mesh_merge_nodes(&split, zero / zero, &merged, NULL), SB_ERROR_ARGUMENT);
    CHECK_INT(merged, nodes - mesh.node_count);
    CHECK_OK(sb_mesh_merge_nodes(&split, 10, &merged, NULL)); /* larger than the mesh: one node is left */
    CHECK_INT(split.node_count, 1);
    CHECK_RESULT(sb_mesh_validate(&split, NULL), SB_ERROR_MESH);
    sb_mesh_free(&split);
    sb_mesh_free(&mesh);
}

static void test_remove(void)
{
    sb_mesh mesh = mesh_beam(SB_HEX8, 3, 2, 2);
    int removed = -1, last;
    mesh_add_regions(&mesh);
    memcpy(mesh_nodes_of(&mesh, 5), mesh_nodes_of(&mesh, 2), 8 * sizeof(int));
    mesh_mirror(&mesh, 5); /* the same corners in another order */
    last = mesh.regions[6];
    CHECK_OK(sb_mesh_remove_duplicate_elements(&mesh, &removed, NULL));
    CHECK_INT(removed, 1);
    CHECK_INT(mesh.element_count, 11);
    CHECK_INT(mesh.regions[5], last);
    CHECK_OK(sb_mesh_remove_duplicate_elements(&mesh, NULL, NULL));
    CHECK_INT(mesh.element_count, 11);
    mesh.element_count = 1;
    CHECK_OK(sb_mesh_remove_unreferenced(&mesh, &removed, NULL));
    CHECK_INT(removed, 36 - 8);
    CHECK_OK(sb_mesh_validate(&mesh, NULL));
    CHECK_NEAR(sb_mesh_volume(&mesh), 2e-6, 2e-6 * mesh_eps(64));
    sb_mesh_free(&mesh);
}

static void test_scale(void)
{
    sb_mesh mesh = mesh_beam(SB_TET4, 2, 2, 2);
    volatile sb_real zero = 0;
    CHECK_OK(sb_mesh_scale(&mesh, MREAL(1e3), NULL));
    CHECK_NEAR(sb_mesh_volume(&mesh), 2.4e4, 2.4e4 * mesh_eps(64));
    CHECK_RESULT(sb_mesh_scale(&mesh, 0, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_scale(&mesh, -1, NULL), SB_ERROR_ARGUMENT);
    check_bad_numbers();
    CHECK_RESULT(sb_mesh_scale(&mesh, zero / zero, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_scale(&mesh, SB_REAL_MAX, NULL), SB_ERROR_NOT_FINITE);
    CHECK_NEAR(sb_mesh_volume(&mesh), 2.4e4, 2.4e4 * mesh_eps(64));
    sb_mesh_free(&mesh);
}

/* ---- topology ---- */

static void test_boundary(void)
{
    for (int t = 0; t < MESH_VOLUMES; t++) {
        sb_mesh mesh = mesh_beam(mesh_volume_types[t], 4, 3, 2);
        sb_boundary all, compact;
        int n, local[SB_MAX_FACE_NODES];
        mesh_add_regions(&mesh);
        CHECK_OK(sb_mesh_boundary(&mesh, 0, NULL, &all, NULL));
        CHECK_OK(sb_mesh_boundary(&mesh, 1, NULL, &compact, NULL));
        CHECK_INT(all.surface.element_count, (mesh_is_hex(mesh.element_type) ? 1 : 2) * 2 * (12 + 8 + 6));
        CHECK_INT(all.surface.node_count, mesh.node_count);
        CHECK(all.nodes == NULL);
        CHECK(compact.surface.node_count < mesh.node_count);
        n = mesh_width(&all.surface);
        for (int f = 0; f < all.surface.element_count; f++) {
            const int *nodes = mesh_nodes_of(&all.surface, f), *few = mesh_nodes_of(&compact.surface, f);
            CHECK_INT(sb_element_face(mesh.element_type, all.faces[f], local, NULL), n);
            CHECK_INT(all.surface.regions[f], mesh.regions[all.elements[f]]);
            CHECK(f == 0 || all.elements[f] > all.elements[f - 1] ||
                  (all.elements[f] == all.elements[f - 1] && all.faces[f] > all.faces[f - 1]));
            for (int a = 0; a < n; a++) {
                CHECK_INT(nodes[a], mesh_nodes_of(&mesh, all.elements[f])[local[a]]);
                CHECK_INT(compact.nodes[few[a]], nodes[a]);
            }
        }
        for (int v = 1; v < compact.surface.node_count; v++)
            CHECK(compact.nodes[v] > compact.nodes[v - 1]);
        CHECK_NEAR(sb_mesh_volume(&compact.surface), 2.4e-5, 2.4e-5 * mesh_eps(256)); /* closed, outward */
        CHECK_RESULT(sb_mesh_boundary(&compact.surface, 0, NULL, &all, NULL), SB_ERROR_ARGUMENT);
        sb_boundary_free(&all);
        sb_boundary_free(&compact);
        sb_boundary_free(NULL);
        CHECK(all.elements == NULL);
        sb_mesh_free(&mesh);
    }
}

static int mesh_shared_corners(const sb_mesh *mesh, int e, int f)
{
    int corners = sb_element_corner_count(mesh->element_type), shared = 0;
    for (int a = 0; a < corners; a++)
        for (int b = 0; b < corners; b++)
            shared += mesh_nodes_of(mesh, e)[a] == mesh_nodes_of(mesh, f)[b];
    return shared;
}

/* Against the definition: neighbours share the corners of a face, and there are no others. */
static void test_neighbours(void)
{
    for (int t = 0; t <= MESH_VOLUMES; t++) {
        int is_surface = t == MESH_VOLUMES;
        sb_mesh mesh = mesh_beam(is_surface ? SB_TET4 : mesh_volume_types[t], 3, 2, 2);
        sb_index_table table;
        int corners, pairs = 0, expected = 0;
        if (is_surface) {
            sb_mesh surface = mesh_skin(&mesh);
            sb_mesh_free(&mesh);
            mesh = surface;
        }
        corners = is_surface ? 2 : (mesh_is_hex(mesh.element_type) ? 4 : 3);
        CHECK_OK(sb_mesh_neighbours(&mesh, NULL, &table, NULL));
        CHECK_INT(table.rows, mesh.element_count);
        CHECK_INT(table.columns, is_surface ? 3 : (mesh_is_hex(mesh.element_type) ? 6 : 4));
        for (int e = 0; e < table.rows; e++) {
            for (int f = 0; f < table.columns; f++) {
                int other = table.items[e * table.columns + f], back = 0;
                if (other < 0)
                    continue;
                pairs++;
                CHECK_INT(mesh_shared_corners(&mesh, e, other), corners);
                for (int g = 0; g < table.columns; g++)
                    back += table.items[other * table.columns + g] == e;
                CHECK_INT(back, 1);
            }
            for (int other = 0; other < table.rows; other++)
                expected += other != e && mesh_shared_corners(&mesh, e, other) == corners;
        }
        CHECK_INT(pairs, expected);
        sb_index_table_free(&table);
        sb_index_table_free(NULL);
        CHECK(table.items == NULL);
        sb_mesh_free(&mesh);
    }
}

static void test_neighbours_crowded(void)
{
    /* three triangles on edge 0-1, a fourth beside the first */
    sb_vec3 nodes[6] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {2, 2, 0}};
    int elements[12] = {0, 1, 2, 1, 0, 3, 0, 1, 4, 2, 1, 5};
    sb_mesh mesh = mesh_none();
    sb_index_table table;
    sb_mesh_report report;
    mesh.nodes = nodes, mesh.node_count = 6;
    mesh.elements = elements, mesh.element_count = 4, mesh.element_type = SB_TRI3;
    CHECK_OK(sb_mesh_neighbours(&mesh, NULL, &table, NULL));
    CHECK_INT(table.items[0], -1);
    CHECK_INT(table.items[1], 3);
    CHECK_INT(table.items[3], -1);
    CHECK_INT(table.items[6], -1);
    CHECK_INT(table.items[9], 0);
    report = mesh_report(&mesh);
    CHECK_INT(report.nonmanifold_edges, 1);
    CHECK_INT(report.open_edges, 7);
    CHECK_INT(report.nonmanifold_vertices, 0);
    sb_mesh_report_free(&report);
    sb_index_table_free(&table);
}

static void test_edges(void)
{
    for (int t = 0; t < MESH_VOLUMES; t++) {
        int nx = 3, ny = 2, nz = 2;
        sb_mesh mesh = mesh_beam(mesh_volume_types[t], nx, ny, nz);
        sb_index_table edges;
        /* grid edges, one diagonal per grid face, one per cell */
        int axis = nx * (ny + 1) * (nz + 1) + (nx + 1) * ny * (nz + 1) + (nx + 1) * (ny + 1) * nz;
        int faces = (nx + 1) * ny * nz + nx * (ny + 1) * nz + nx * ny * (nz + 1);
        CHECK_OK(sb_mesh_edges(&mesh, NULL, &edges, NULL));
        CHECK_INT(edges.columns, 2);
        CHECK_INT(edges.rows, mesh_is_hex(mesh.element_type) ? axis : axis + faces + nx * ny * nz);
        for (int i = 0; i < edges.rows; i++) {
            const int *edge = edges.items + 2 * i;
            CHECK(edge[0] < edge[1]);
            CHECK(i == 0 || edge[-2] < edge[0] || (edge[-2] == edge[0] && edge[-1] < edge[1]));
        }
        sb_index_table_free(&edges);
        sb_mesh_free(&mesh);
    }
}

static void test_node_elements(void)
{
    sb_mesh mesh = mesh_beam(SB_TET10, 2, 2, 2);
    sb_index_lists lists;
    CHECK_OK(sb_mesh_node_elements(&mesh, NULL, &lists, NULL));
    CHECK_INT(lists.count, mesh.node_count);
    CHECK_INT(lists.offsets[lists.count], 10 * mesh.element_count);
    for (int v = 0; v < lists.count; v++) {
        for (int i = lists.offsets[v]; i < lists.offsets[v + 1]; i++) {
            int found = 0;
            for (int a = 0; a < 10; a++)
                found += mesh_nodes_of(&mesh, lists.items[i])[a] == v;
            CHECK_INT(found, 1);
            CHECK(i == lists.offsets[v] || lists.items[i] > lists.items[i - 1]);
        }
    }
    sb_index_lists_free(&lists);
    sb_index_lists_free(NULL);
    CHECK(lists.items == NULL && lists.offsets == NULL);
    sb_mesh_free(&mesh);
}

/* Beams glued end to end through shuffled element order: parts are found however they are listed. */
static void test_components(void)
{
    sb_mesh mesh = mesh_beam(SB_TET4, 9, 1, 1);
    sb_index_table labels;
    unsigned long long seed = 9;
    int count = 0, kept = 0;
    for (int e = 0; e < mesh.element_count; e++) /* drop the cells 3 and 6 of the row: three parts */
        if (e / 6 != 3 && e / 6 != 6)
            memmove(mesh_nodes_of(&mesh, kept++), mesh_nodes_of(&mesh, e), 4 * sizeof(int));
    mesh.element_count = kept;
    for (int e = kept - 1; e > 0; e--) {
        int other = (int)(check_random(&seed) * (e + 1)), keep[4];
        memcpy(keep, mesh_nodes_of(&mesh, e), sizeof keep);
        memmove(mesh_nodes_of(&mesh, e), mesh_nodes_of(&mesh, other), sizeof keep);
        memcpy(mesh_nodes_of(&mesh, other), keep, sizeof keep);
    }
    CHECK_OK(sb_mesh_components(&mesh, NULL, &labels, &count, NULL));
    CHECK_INT(count, 3);
    CHECK_INT(labels.rows, kept);
    for (int e = 0, highest = -1; e < kept; e++) {
        double x = (double)mesh.nodes[mesh_nodes_of(&mesh, e)[0]].x;
        CHECK(labels.items[e] >= 0 && labels.items[e] <= highest + 1);
        highest = labels.items[e] > highest ? labels.items[e] : highest;
        for (int f = 0; f < e; f++) {
            double y = (double)mesh.nodes[mesh_nodes_of(&mesh, f)[0]].x;
            int same = (x < 0.015) == (y < 0.015) && (x > 0.029) == (y > 0.029);
            CHECK_INT(labels.items[e] == labels.items[f], same);
        }
    }
    sb_index_table_free(&labels);
    sb_mesh_free(&mesh);
}

/* ---- conversions ---- */

static void test_to_tet10(void)
{
    sb_mesh mesh = mesh_beam(SB_TET4, 3, 2, 2), tet10 = mesh_none();
    sb_index_table edges;
    mesh_add_regions(&mesh);
    CHECK_OK(sb_mesh_to_tet10(&mesh, NULL, &tet10, NULL));
    CHECK_OK(sb_mesh_edges(&mesh, NULL, &edges, NULL));
    CHECK_INT(tet10.node_count, mesh.node_count + edges.rows);
    CHECK_OK(sb_mesh_validate(&tet10, NULL));
    CHECK(memcmp(tet10.regions, mesh.regions, sizeof(int) * (size_t)mesh.element_count) == 0);
    for (int e = 0; e < mesh.element_count; e++) {
        const int *nodes = mesh_nodes_of(&tet10, e);
        int edge[3];
        CHECK(memcmp(nodes, mesh_nodes_of(&mesh, e), 4 * sizeof(int)) == 0);
        for (int i = 0; i < 6; i++) {
            sb_vec3 middle;
            sb_element_edge(SB_TET10, i, edge);
            middle = sb_v3_scale(MREAL(0.5), sb_v3_add(tet10.nodes[nodes[edge[0]]], tet10.nodes[nodes[edge[1]]]));
            CHECK_NEAR(sb_v3_norm(sb_v3_sub(middle, tet10.nodes[nodes[edge[2]]])), 0, mesh_eps(0.1));
        }
    }
    CHECK_NEAR(sb_mesh_volume(&tet10), 2.4e-5, 2.4e-5 * mesh_eps(64));
    CHECK_RESULT(sb_mesh_to_tet10(&tet10, NULL, &mesh, NULL), SB_ERROR_ARGUMENT);
    sb_index_table_free(&edges);
    sb_mesh_free(&tet10);
    sb_mesh_free(&mesh);
}

/* Every new node stands where the hex8 it came from maps its parameters, and neighbours share it. */
static void test_to_quadratic_hex(void)
{
    for (int t = 3; t < MESH_VOLUMES; t++) {
        sb_mesh mesh = mesh_beam(SB_HEX8, 3, 2, 2), raised = mesh_none(), none = mesh_none();
        sb_element_type type = mesh_volume_types[t];
        sb_index_table edges;
        unsigned long long seed = 8;
        int faces = 4 * 2 * 2 + 3 * 3 * 2 + 3 * 2 * 3; /* of the 3 x 2 x 2 cells, in the three directions */
        for (int v = 0; v < mesh.node_count; v++)
            mesh.nodes[v].y += MREAL(check_random_in(&seed, -1e-3, 1e-3));
        mesh_add_regions(&mesh);
        CHECK_OK(sb_mesh_edges(&mesh, NULL, &edges, NULL));
        CHECK_OK(type == SB_HEX20 ? sb_mesh_to_hex20(&mesh, NULL, &raised, NULL)
                                  : sb_mesh_to_hex27(&mesh, NULL, &raised, NULL));
        CHECK_INT(raised.element_type, type);
        CHECK_INT(raised.node_count,
                  mesh.node_count + edges.rows + (type == SB_HEX27 ? faces + mesh.element_count : 0));
        CHECK(memcmp(raised.nodes, mesh.nodes, sizeof(sb_vec3) * (size_t)mesh.node_count) == 0);
        CHECK(memcmp(raised.regions, mesh.regions, sizeof(int) * (size_t)mesh.element_count) == 0);
        CHECK_OK(sb_mesh_validate(&raised, NULL));
        for (int e = 0; e < mesh.element_count; e++)
            for (int a = 0; a < mesh_width(&raised); a++) {
                sb_real xi[3] = {0, 0, 0}, shape[8];
                sb_vec3 expected = sb_v3(0, 0, 0);
                sb_element_node_point(type, a, xi);
                sb_element_shape(SB_HEX8, xi, shape, NULL);
                for (int c = 0; c < 8; c++)
                    expected = sb_v3_madd(expected, shape[c], mesh.nodes[mesh_nodes_of(&mesh, e)[c]]);
                CHECK_NEAR(sb_v3_norm(sb_v3_sub(raised.nodes[mesh_nodes_of(&raised, e)[a]], expected)), 0,
                           mesh_eps(0.2));
            }
        CHECK_NEAR(sb_mesh_volume(&raised), sb_mesh_volume(&mesh), 2.4e-5 * mesh_eps(64));
        CHECK_RESULT(sb_mesh_to_hex20(&raised, NULL, &none, NULL), SB_ERROR_ARGUMENT);
        CHECK_RESULT(sb_mesh_to_hex27(&raised, NULL, &none, NULL), SB_ERROR_ARGUMENT);
        CHECK_RESULT(sb_mesh_to_hex27(&mesh, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
        CHECK(none.nodes == NULL);
        sb_index_table_free(&edges);
        sb_mesh_free(&raised);
        sb_mesh_free(&mesh);
    }
}

static int mesh_bandwidth(const sb_mesh *mesh)
{
    int widest = 0;
    for (int e = 0; e < mesh->element_count; e++)
        for (int a = 0; a < mesh_width(mesh); a++)
            for (int b = 0; b < a; b++) {
                int distance = abs(mesh_nodes_of(mesh, e)[a] - mesh_nodes_of(mesh, e)[b]);
                widest = distance > widest ? distance : widest;
            }
    return widest;
}

/* A random renumbering of nodes. */
static void mesh_shuffle(sb_mesh *mesh, unsigned long long seed)
{
    int *map = (int *)malloc(sizeof(int) * (size_t)mesh->node_count);
    sb_vec3 *nodes = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)mesh->node_count);
    for (int v = 0; v < mesh->node_count; v++)
        map[v] = v;
    for (int v = mesh->node_count - 1; v > 0; v--)
        mesh_swap_nodes(map, v, (int)(check_random(&seed) * (v + 1)));
    for (int v = 0; v < mesh->node_count; v++)
        nodes[map[v]] = mesh->nodes[v];
    memcpy(mesh->nodes, nodes, sizeof(sb_vec3) * (size_t)mesh->node_count);
    for (int i = 0; i < mesh->element_count * mesh_width(mesh); i++)
        mesh->elements[i] = map[mesh->elements[i]];
    free(map);
    free(nodes);
}

static void test_reorder(void)
{
    for (int t = 0; t < MESH_VOLUMES; t++) {
        sb_mesh mesh = mesh_none(), old = mesh_none();
        int *node_map, *element_map, lowest_before = -1;
        CHECK_OK(sb_mesh_beam(mesh_volume_types[t], 20, 3, 3, sb_v3(MREAL(0.2), MREAL(0.03), MREAL(0.03)), NULL, &mesh,
                              NULL));
        mesh_add_regions(&mesh);
        mesh_shuffle(&mesh, 11);
        CHECK_OK(sb_mesh_copy(&mesh, NULL, &old, NULL));
        node_map = (int *)malloc(sizeof(int) * (size_t)mesh.node_count);
        element_map = (int *)malloc(sizeof(int) * (size_t)mesh.element_count);
        CHECK_OK(sb_mesh_reorder(&mesh, node_map, element_map, NULL));
        CHECK_OK(sb_mesh_validate(&mesh, NULL));
        /* two slices of 4 x 4 nodes for linear elements; quadratic ones have nodes between them: hex20 three times 56,
         * hex27 three times 98 */
        CHECK(mesh_bandwidth(&mesh) <= (t == 1 || t == 3 ? 170 : (t == 4 ? 294 : 45)));
        CHECK(mesh_bandwidth(&old) > mesh.node_count / 2);
        for (int v = 0; v < old.node_count; v++)
            CHECK(memcmp(&mesh.nodes[node_map[v]], &old.nodes[v], sizeof(sb_vec3)) == 0);
        for (int e = 0; e < old.element_count; e++) {
            CHECK_INT(mesh.regions[element_map[e]], old.regions[e]);
            for (int a = 0; a < mesh_width(&old); a++)
                CHECK_INT(mesh_nodes_of(&mesh, element_map[e])[a], node_map[mesh_nodes_of(&old, e)[a]]);
        }
        for (int e = 0; e < mesh.element_count; e++) {
            int lowest = INT_MAX;
            for (int a = 0; a < mesh_width(&mesh); a++)
                lowest = mesh_nodes_of(&mesh, e)[a] < lowest ? mesh_nodes_of(&mesh, e)[a] : lowest;
            CHECK(lowest >= lowest_before);
            lowest_before = lowest;
        }
        free(node_map);
        free(element_map);
        sb_mesh_free(&mesh);
        sb_mesh_free(&old);
    }
}

/* Parts and unused nodes are numbered too. */
static void test_reorder_parts(void)
{
    sb_mesh mesh = mesh_beam(SB_TET4, 9, 1, 1);
    int seen[40] = {0}, node_map[40];
    mesh.element_count = 6; /* leaves 32 of 40 nodes without elements */
    memcpy(mesh_nodes_of(&mesh, 1), mesh_nodes_of(&mesh, 50), 4 * sizeof(int));
    CHECK_INT(mesh.node_count, 40);
    CHECK_OK(sb_mesh_reorder(&mesh, node_map, NULL, NULL));
    for (int v = 0; v < 40; v++)
        seen[node_map[v]]++;
    for (int v = 0; v < 40; v++)
        CHECK_INT(seen[v], 1);
    CHECK_OK(sb_mesh_validate(&mesh, NULL));
    CHECK_OK(sb_mesh_reorder(&mesh, NULL, NULL, NULL));
    sb_mesh_free(&mesh);
}

/* ---- failures ---- */

/* Everything that allocates, by number; outputs are released here. Returns SB_ERROR_UNSUPPORTED past the
 * end. */
static sb_result mesh_call(int which, sb_mesh *mesh, sb_mesh *surface, const sb_allocator *allocator)
{
    sb_mesh made = mesh_none();
    sb_boundary boundary;
    sb_index_table table;
    sb_index_lists lists;
    sb_mesh_report report;
    sb_result result = SB_ERROR_UNSUPPORTED;
    memset(&boundary, 0, sizeof boundary);
    memset(&table, 0, sizeof table);
    memset(&lists, 0, sizeof lists);
    memset(&report, 0, sizeof report);
    switch (which) {
    case 0: result = sb_mesh_copy(mesh, allocator, &made, NULL); break;
    case 1: result = sb_mesh_check(mesh, allocator, &report, NULL); break;
    case 2: result = sb_mesh_check(surface, allocator, &report, NULL); break;
    case 3: result = sb_mesh_boundary(mesh, 0, allocator, &boundary, NULL); break;
    case 4: result = sb_mesh_boundary(mesh, 1, allocator, &boundary, NULL); break;
    case 5: result = sb_mesh_neighbours(mesh, allocator, &table, NULL); break;
    case 6: result = sb_mesh_edges(mesh, allocator, &table, NULL); break;
    case 7: result = sb_mesh_node_elements(mesh, allocator, &lists, NULL); break;
    case 8: result = sb_mesh_components(mesh, allocator, &table, NULL, NULL); break;
    case 9: result = sb_mesh_to_tet10(mesh, allocator, &made, NULL); break;
    case 10: result = sb_mesh_merge_nodes(mesh, -1, NULL, NULL); break;
    case 11: result = sb_mesh_remove_unreferenced(mesh, NULL, NULL); break;
    case 12: result = sb_mesh_remove_duplicate_elements(mesh, NULL, NULL); break;
    case 13: result = sb_mesh_orient_surface(surface, NULL, NULL); break;
    case 14: result = sb_mesh_reorder(mesh, NULL, NULL, NULL); break;
    default: break;
    }
    if (result != SB_OK) /* outputs as they were */
        CHECK(!made.nodes && !boundary.elements && !boundary.surface.nodes && !table.items && !lists.items &&
              !report.bad);
    sb_mesh_free(&made);
    sb_boundary_free(&boundary);
    sb_index_table_free(&table);
    sb_index_lists_free(&lists);
    sb_mesh_report_free(&report);
    return result;
}

/* A mesh with work for every repair: copies of nodes, an unused node, an element twice, some surface
 * turned. */
static sb_mesh mesh_to_repair(const sb_allocator *allocator)
{
    sb_mesh beam = mesh_beam(SB_TET4, 2, 2, 1), split = mesh_explode(&beam), mesh = mesh_none();
    mesh_add_regions(&split);
    memcpy(mesh_nodes_of(&split, 3), mesh_nodes_of(&split, 4), 4 * sizeof(int));
    CHECK_OK(sb_mesh_copy(&split, allocator, &mesh, NULL));
    sb_mesh_free(&beam);
    sb_mesh_free(&split);
    return mesh;
}

static sb_mesh mesh_surface_to_repair(const sb_allocator *allocator)
{
    sb_mesh beam = mesh_beam(SB_TET4, 2, 2, 1), skin = mesh_skin(&beam), mesh = mesh_none();
    CHECK_OK(sb_mesh_copy(&skin, allocator, &mesh, NULL));
    mesh_mirror(&mesh, 2);
    sb_mesh_free(&beam);
    sb_mesh_free(&skin);
    return mesh;
}

static int mesh_same(const sb_mesh *a, const sb_mesh *b)
{
    return a->node_count == b->node_count && a->element_count == b->element_count &&
           memcmp(a->nodes, b->nodes, sizeof(sb_vec3) * (size_t)a->node_count) == 0 &&
           memcmp(a->elements, b->elements, sizeof(int) * (size_t)(a->element_count * mesh_width(a))) == 0 &&
           (!a->regions || memcmp(a->regions, b->regions, sizeof(int) * (size_t)a->element_count) == 0);
}

/* Every allocation fails in turn: the call says so, nothing leaks and nothing is changed. */
static void test_allocation_failures(void)
{
    int calls = 0;
    for (int which = 0;; which++) {
        mesh_memory memory;
        sb_allocator allocator = mesh_counting(&memory);
        sb_mesh mesh = mesh_to_repair(&allocator), surface = mesh_surface_to_repair(&allocator);
        sb_mesh same = mesh_to_repair(NULL), same_surface = mesh_surface_to_repair(NULL);
        int live = memory.live;
        sb_result result = SB_ERROR_MEMORY;
        for (int fail = 0; result == SB_ERROR_MEMORY && fail < 100; fail++) {
            CHECK(mesh_same(&mesh, &same) && mesh_same(&surface, &same_surface));
            memory.calls = 0;
            memory.fail_at = fail;
            result = mesh_call(which, &mesh, &surface, &allocator);
            CHECK(result == SB_ERROR_MEMORY || memory.calls <= fail);
            CHECK_INT(memory.live, live);
            calls++;
        }
        memory.fail_at = -1;
        sb_mesh_free(&mesh);
        sb_mesh_free(&surface);
        sb_mesh_free(&same);
        sb_mesh_free(&same_surface);
        CHECK_INT(memory.live, 0);
        if (result == SB_ERROR_UNSUPPORTED) {
            CHECK_INT(which, 15);
            break;
        }
        CHECK_OK(result);
    }
    CHECK(calls > 60);
}

static void test_null_outputs(void)
{
    sb_mesh mesh = mesh_beam(SB_TET4, 1, 1, 1);
    CHECK_RESULT(sb_mesh_check(&mesh, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_check(NULL, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_boundary(&mesh, 0, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_neighbours(&mesh, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_edges(&mesh, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_node_elements(&mesh, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_components(&mesh, NULL, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_to_tet10(&mesh, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_reorder(NULL, NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_RESULT(sb_mesh_orient(NULL, NULL, NULL), SB_ERROR_ARGUMENT);
    CHECK_INT(sb_mesh_volume(NULL) == 0, 1);
    sb_mesh_free(&mesh);
}

/* ---- hostile meshes ---- */

/* Arrays of random content: a few nodes shared by many elements, indices just outside, extreme
 * coordinates. */
static sb_mesh mesh_random(unsigned long long *seed)
{
    static const sb_element_type types[] = {SB_TRI3, SB_TRI6,  SB_QUAD4, SB_QUAD8, SB_QUAD9,
                                            SB_TET4, SB_TET10, SB_HEX8,  SB_HEX20, SB_HEX27};
    static const double specials[] = {0, 1, -1, 1e-30, 1e30, 1e-38, 3e38, 0.5};
    sb_mesh mesh = mesh_none();
    volatile sb_real zero = 0;
    double wildness = check_random(seed);
    mesh.element_type = types[(int)(check_random(seed) * 10)];
    mesh.node_count = 1 + (int)(check_random(seed) * 40);
    mesh.element_count = 1 + (int)(check_random(seed) * 60);
    mesh.nodes = (sb_vec3 *)malloc(sizeof(sb_vec3) * (size_t)mesh.node_count);
    mesh.elements = (int *)malloc(sizeof(int) * (size_t)(mesh.element_count * mesh_width(&mesh)));
    for (int v = 0; v < mesh.node_count; v++) {
        sb_real x[3];
        for (int k = 0; k < 3; k++) {
            x[k] = MREAL(check_random(seed) < 0.5 ? check_random(seed) : (int)(check_random(seed) * 3));
            if (wildness > 0.6 && check_random(seed) < 0.1)
                x[k] = MREAL(specials[(int)(check_random(seed) * 8)]);
            if (wildness > 0.9 && check_random(seed) < 0.02)
                x[k] = check_random(seed) < 0.5 ? zero / zero : 1 / zero;
        }
        mesh.nodes[v] = sb_v3(x[0], x[1], x[2]);
    }
    for (int i = 0; i < mesh.element_count * mesh_width(&mesh); i++) {
        mesh.elements[i] = (int)(check_random(seed) * mesh.node_count);
        if (wildness > 0.8 && check_random(seed) < 0.01)
            mesh.elements[i] = check_random(seed) < 0.5 ? mesh.node_count : -1 - (int)(check_random(seed) * 1e9);
    }
    return mesh;
}

/* No content may crash a call, and what the calls say must agree. Run under sanitizers this is a small
 * fuzzer. */
static void test_hostile(void)
{
    unsigned long long seed = 12345;
    check_bad_numbers();
    for (int round = 0; round < 400; round++) {
        sb_mesh mesh = mesh_random(&seed), keep = mesh_none(), made = mesh_none();
        sb_error error;
        sb_mesh_report report = mesh_report(&mesh);
        sb_result valid = sb_mesh_validate(&mesh, &error);
        int own = 0, in_range;
        for (int d = SB_MESH_INDEX_RANGE; d <= SB_MESH_BAD_MIDSIDE; d++)
            own += sb_element_dimension(mesh.element_type) == 2 && d == SB_MESH_FLAT ? 0 : report.defect_count[d];
        CHECK_INT(valid == SB_OK, own == 0 && report.not_finite_nodes == 0);
        if (valid == SB_ERROR_INDEX || valid == SB_ERROR_MESH)
            CHECK(error.element >= 0 && error.element < mesh.element_count);
        CHECK_INT(report.bad_count + report.defect_count[SB_MESH_SOUND], mesh.element_count);
        in_range = report.not_finite_nodes == 0 && report.defect_count[SB_MESH_INDEX_RANGE] == 0;
        CHECK_OK(sb_mesh_copy(&mesh, NULL, &keep, NULL));
        for (int which = 1; which < 15; which++) {
            sb_result result = mesh_call(which, &mesh, &mesh, NULL);
            CHECK(in_range || which <= 2 ? result != SB_ERROR_INDEX : result != SB_OK);
            if (sb_mesh_orient(&mesh, NULL, NULL) == SB_OK && sb_element_dimension(mesh.element_type) == 3)
                for (int e = 0; e < mesh.element_count; e++)
                    CHECK(sb_is_finite(sb_mesh_element_quality(&mesh, e)) || !sb_is_finite(sb_mesh_volume(&mesh)));
        }
        if (in_range && sb_mesh_remove_unreferenced(&keep, NULL, NULL) == SB_OK &&
            sb_mesh_to_tet10(&keep, NULL, &made, NULL) == SB_OK)
            CHECK_INT(made.element_count, keep.element_count);
        sb_mesh_free(&made);
        sb_mesh_free(&keep);
        mesh_drop(&mesh, &report);
    }
}

CHECK_SUITE(mesh, {"free and copy", test_free_and_copy}, {"validate: counts", test_validate_counts},
            {"validate: nodes and indices", test_validate_nodes_and_indices},
            {"validate: inverted at any scale", test_validate_inverted}, {"validate: flat", test_validate_flat},
            {"validate: crossed hex", test_validate_hex}, {"validate: mid-edge nodes", test_validate_midside},
            {"validate: quadratic hexes", test_validate_quadratic_hex}, {"validate: surfaces", test_validate_surface},
            {"report of a sound mesh", test_report_sound},
            {"report lists every bad element", test_report_lists_every_bad_element},
            {"bad files: elements", test_bad_files_elements}, {"bad files: surfaces", test_bad_files_surfaces},
            {"bad files: nodes", test_bad_files_nodes}, {"volume of curved elements", test_volume_curved},
            {"volume of warped hexes", test_volume_hex}, {"area and bounds", test_area_and_bounds},
            {"quality", test_quality}, {"orient volumes", test_orient_volume}, {"orient surfaces", test_orient_surface},
            {"orient a one-sided surface", test_orient_one_sided}, {"merge nodes", test_merge_nodes},
            {"merge tolerance", test_merge_tolerance}, {"remove elements and nodes", test_remove},
            {"scale", test_scale}, {"boundary", test_boundary}, {"neighbours", test_neighbours},
            {"neighbours at crowded edges", test_neighbours_crowded}, {"edges", test_edges},
            {"elements of nodes", test_node_elements}, {"components", test_components},
            {"tet4 to tet10", test_to_tet10}, {"hex8 to hex20 and hex27", test_to_quadratic_hex},
            {"reorder", test_reorder}, {"reorder parts and unused nodes", test_reorder_parts},
            {"every allocation failing", test_allocation_failures}, {"null outputs", test_null_outputs},
            {"hostile meshes", test_hostile});
