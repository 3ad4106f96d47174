/* custom_element: an element that the library does not have, a wedge of six nodes, described by a table.
 *
 *     cc -O3 custom_element.c -lm -o custom_element
 *     ./custom_element [-n CELLS] [-o OUT.vtk]
 *
 * The first part is all that a new element takes. The second puts it to the patch test, which an element must pass to
 * converge: on a distorted mesh whose boundary follows a linear field, every inner node must find that field. The third
 * bends a beam of wedges under its own weight and writes it for ParaView. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char help[] =
    "custom_element [-n CELLS] [-o OUT.vtk]\n"
    "\n"
    "Defines a wedge element by a table, runs the patch test with it, then lets a clamped beam of wedges sag and\n"
    "writes it with displacement and von Mises stress.\n"
    "\n"
    "  -n CELLS    cells over the beam's height, 1 to 20; a cell is two wedges (3)\n"
    "  -o OUT.vtk  where the bent beam goes (custom_element.vtk)\n";

enum { EXIT_FINE = 0, EXIT_USAGE = 2, EXIT_FAILED = 3 };

/* ==== the element ======================================================================================
 * A triangle (r, s) with r, s >= 0 and r + s <= 1, drawn out along t from -1 to 1. Nodes 0 1 2 lie at t = -1, 3 4 5
 * above them: the order of VTK's wedge. N_a = L_a(r, s) (1 -+ t) / 2 with L = (1 - r - s, r, s). */

static void wedge_shape(const void *user, const sb_real xi[3], sb_real *shape, sb_real (*gradient)[3])
{
    static const sb_real slope[3][2] = {{-1, -1}, {1, 0}, {0, 1}}; /* of L_a along r and s */
    const sb_real area[3] = {1 - xi[0] - xi[1], xi[0], xi[1]};
    (void)user;
    for (int a = 0; a < 6; a++) {
        sb_real side = a < 3 ? -1 : 1, height = (1 + side * xi[2]) / 2;
        if (shape)
            shape[a] = area[a % 3] * height;
        if (gradient) {
            gradient[a][0] = slope[a % 3][0] * height;
            gradient[a][1] = slope[a % 3][1] * height;
            gradient[a][2] = area[a % 3] * side / 2;
        }
    }
}

static const sb_real wedge_nodes[6][3] = {{0, 0, -1}, {1, 0, -1}, {0, 1, -1}, {0, 0, 1}, {1, 0, 1}, {0, 1, 1}};

/* Three points of the triangle (degree 2) times Gauss's two (degree 3): enough for stiffness and mass. */
#define A (1.0 / 6)
#define B (2.0 / 3)
#define T 0.57735026918962576451 /* 1 / sqrt(3) */
static const sb_real wedge_points[6][3] = {{A, A, -T}, {B, A, -T}, {A, B, -T}, {A, A, T}, {B, A, T}, {A, B, T}};
static const sb_real wedge_weights[6] = {A, A, A, A, A, A};

/* Counter-clockwise seen from outside. Tractions, neighbours and the boundary need them. */
static const sb_element_table_face wedge_faces[5] = {
    {SB_TRI3, {0, 2, 1}},     {SB_TRI3, {3, 4, 5}},     {SB_QUAD4, {0, 1, 4, 3}},
    {SB_QUAD4, {1, 2, 5, 4}}, {SB_QUAD4, {2, 0, 3, 5}},
};

static sb_element_table wedge_table(void)
{
    sb_element_table table;
    memset(&table, 0, sizeof table);
    table.name = "wedge";
    table.node_count = table.corner_count = 6;
    table.node_points = wedge_nodes;
    table.shape = wedge_shape;
    table.point_count = table.mass_point_count = 6;
    table.points = table.mass_points = wedge_points;
    table.weights = table.mass_weights = wedge_weights;
    table.face_count = 5;
    table.faces = wedge_faces;
    table.vtk_type = 13; /* VTK_WEDGE */
    return table;
}

/* ==== meshes of it ===================================================================================== */

/* A box of nx x ny x nz cells, each cut into two wedges; 0 when memory is short. */
static int make_box(const sb_element_table *table, int nx, int ny, int nz, sb_vec3 size, sb_mesh *mesh, sb_error *error)
{
    static const int halves[12] = {0, 1, 3, 4, 5, 7, 1, 2, 3, 5, 6, 7};
    int *wedges;
    if (sb_mesh_beam(SB_HEX8, nx, ny, nz, size, NULL, mesh, error) != SB_OK)
        return 0;
    wedges = (int *)malloc(12 * sizeof(int) * (size_t)mesh->element_count);
    if (!wedges) {
        sb_mesh_free(mesh);
        snprintf(error->message, sizeof error->message, "out of memory for %d wedges", 2 * nx * ny * nz);
        return 0;
    }
    for (int e = 0; e < mesh->element_count; e++)
        for (int k = 0; k < 12; k++)
            wedges[12 * e + k] = mesh->elements[8 * e + halves[k]];
    free(mesh->elements); /* made by malloc, since sb_mesh_beam was given no allocator */
    mesh->elements = wedges;
    mesh->element_count *= 2;
    mesh->element_type = SB_CUSTOM;
    mesh->table = table;
    return 1;
}

static int is_on_boundary(sb_vec3 x, sb_vec3 size)
{
    const sb_real edge = (sb_real)1e-6;
    return x.x < edge || x.y < edge || x.z < edge || x.x > size.x - edge || x.y > size.y - edge || x.z > size.z - edge;
}

/* A number in [-1, 1] that looks random: the same one everywhere for the same i. */
static sb_real scatter(unsigned i) { return (sb_real)((i * 2654435761u >> 8) % 2001u) / 1000 - 1; }

/* The linear field of the patch test (m). */
static sb_vec3 field(sb_vec3 x)
{
    return sb_v3((sb_real)0.10 * x.x + (sb_real)0.04 * x.y, (sb_real)0.06 * x.z - (sb_real)0.05 * x.y,
                 (sb_real)0.05 * x.x + (sb_real)0.07 * x.z);
}

/* ==== the patch test =================================================================================== */

/* Largest distance of a node from the linear field over the largest displacement; -1 when something failed. */
static double run_patch(const sb_mesh *mesh, sb_vec3 size, sb_error *error)
{
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_step_info info;
    sb_body *body = NULL;
    sb_real worst = 0, largest = 0;
    sb_result result = SB_OK;
    def.mesh = mesh;
    def.material = sb_material_neo_hookean(5000, (sb_real)0.45, 1060);
    if (sb_body_create(&def, &body, error) != SB_OK)
        return -1;
    for (int i = 0; i < mesh->node_count && result == SB_OK; i++) {
        sb_vec3 u = field(mesh->nodes[i]);
        if (is_on_boundary(mesh->nodes[i], size))
            result = sb_body_prescribe(body, &i, 1, SB_XYZ, &u, 1);
    }
    options.tolerance = (sb_real)1e-14;
    if (result != SB_OK || (result = sb_body_solve_static(body, &options, &info)) != SB_OK) {
        snprintf(error->message, sizeof error->message, "the patch test: %s", sb_result_string(result));
        sb_body_destroy(body);
        return -1;
    }
    for (int i = 0; i < mesh->node_count; i++) {
        sb_vec3 u = field(mesh->nodes[i]);
        worst = sb_max(worst, sb_v3_norm(sb_v3_sub(sb_body_displacements(body)[i], u)));
        largest = sb_max(largest, sb_v3_norm(u));
    }
    sb_body_destroy(body);
    return (double)(worst / largest);
}

static int patch_test(const sb_element_table *table, sb_error *error)
{
    const sb_vec3 size = sb_v3(1, 1, 1);
    sb_mesh mesh;
    double worst;
    if (!make_box(table, 3, 3, 3, size, &mesh, error))
        return 0;
    for (int i = 0; i < mesh.node_count; i++) /* out of shape inside, by up to a quarter of a cell */
        if (!is_on_boundary(mesh.nodes[i], size))
            mesh.nodes[i] = sb_v3_madd(
                mesh.nodes[i], (sb_real)0.08,
                sb_v3(scatter(3u * (unsigned)i), scatter(3u * (unsigned)i + 1), scatter(3u * (unsigned)i + 2)));
    worst = run_patch(&mesh, size, error);
    if (worst >= 0)
        printf("patch test: %d distorted wedges, a linear field is met to %.1e of itself\n", mesh.element_count, worst);
    sb_mesh_free(&mesh);
    return worst >= 0;
}

/* ==== the beam ========================================================================================= */

static int write_beam(const char *path, const sb_mesh *mesh, const sb_body *body, sb_error *error)
{
    sb_field fields[2];
    sb_mesh bent;
    sb_real *stress;
    sb_result result;
    if (sb_mesh_copy(mesh, NULL, &bent, error) != SB_OK)
        return 0;
    stress = (sb_real *)malloc(sizeof(sb_real) * (size_t)mesh->element_count);
    if (!stress) {
        sb_mesh_free(&bent);
        snprintf(error->message, sizeof error->message, "out of memory for the stress");
        return 0;
    }
    memcpy(bent.nodes, sb_body_positions(body), sizeof(sb_vec3) * (size_t)mesh->node_count);
    sb_body_von_mises(body, stress);
    fields[0].name = "displacement", fields[0].location = SB_FIELD_NODES, fields[0].components = 3;
    fields[0].values = &sb_body_displacements(body)->x;
    fields[1].name = "von_mises", fields[1].location = SB_FIELD_ELEMENTS, fields[1].components = 1;
    fields[1].values = stress;
    result = sb_mesh_save_vtk(path, &bent, fields, 2, error);
    free(stress);
    sb_mesh_free(&bent);
    return result == SB_OK;
}

static int solve_beam(const char *path, const sb_mesh *mesh, sb_body *body, sb_error *error)
{
    sb_step_info info;
    sb_real sag = 0;
    for (int i = 0; i < mesh->node_count; i++)
        if (mesh->nodes[i].x == 0 && sb_body_fix_nodes(body, &i, 1, SB_XYZ) != SB_OK) {
            snprintf(error->message, sizeof error->message, "the end cannot be clamped");
            return 0;
        }
    if (sb_body_solve_static(body, NULL, &info) != SB_OK) {
        *error = info.error;
        return 0;
    }
    for (int i = 0; i < mesh->node_count; i++)
        sag = sb_max(sag, -sb_body_displacements(body)[i].z);
    if (!write_beam(path, mesh, body, error))
        return 0;
    printf("beam: %d wedges, %d nodes, sags by %.2f mm under its own weight in %d Newton steps: %s\n",
           mesh->element_count, mesh->node_count, 1e3 * (double)sag, info.newton_iterations, path);
    return 1;
}

/* A beam of 200 x 50 x 50 mm, E = 200 kPa, clamped at one end. */
static int bend_beam(const sb_element_table *table, int cells, const char *path, sb_error *error)
{
    sb_body_def def = sb_default_body_def();
    sb_body *body = NULL;
    sb_mesh mesh;
    int done = 0;
    if (!make_box(table, 4 * cells, cells, cells, sb_v3((sb_real)0.2, (sb_real)0.05, (sb_real)0.05), &mesh, error))
        return 0;
    def.mesh = &mesh;
    def.material = sb_material_neo_hookean(200000, (sb_real)0.4, 1060);
    def.gravity = sb_v3(0, 0, (sb_real)-9.81);
    if (sb_body_create(&def, &body, error) == SB_OK)
        done = solve_beam(path, &mesh, body, error);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return done;
}

/* ==== main ============================================================================================= */

static int complain(const char *what, const char *why)
{
    fprintf(stderr, "custom_element: %s %s\n", what, why);
    return EXIT_USAGE;
}

/* Reads the arguments; EXIT_FINE, or EXIT_USAGE with a message. */
static int take_arguments(int argc, char **argv, int *cells, const char **path)
{
    for (int i = 1; i < argc; i += 2) {
        char *end;
        if (strcmp(argv[i], "-n") != 0 && strcmp(argv[i], "-o") != 0)
            return complain(argv[i], "is no option; see --help");
        if (i + 1 == argc)
            return complain(argv[i], "needs a value; see --help");
        if (argv[i][1] == 'o') {
            *path = argv[i + 1];
            continue;
        }
        long value = strtol(argv[i + 1], &end, 10);
        if (end == argv[i + 1] || *end || value < 1 || value > 20)
            return complain("-n needs a whole number from 1 to 20, not", argv[i + 1]);
        *cells = (int)value;
    }
    return EXIT_FINE;
}

static int program(int argc, char **argv)
{
    const char *path = "custom_element.vtk";
    int cells = 3, status;
    sb_element_table table = wedge_table();
    sb_error error;
    memset(&error, 0, sizeof error);
    if (argc == 2 && (strcmp(argv[1], "--help") == 0 || strcmp(argv[1], "-h") == 0)) {
        fputs(help, stdout);
        return EXIT_FINE;
    }
    status = take_arguments(argc, argv, &cells, &path);
    if (status != EXIT_FINE)
        return status;
    if (sb_element_table_check(&table, &error) == SB_OK && patch_test(&table, &error) &&
        bend_beam(&table, cells, path, &error))
        return EXIT_FINE;
    fprintf(stderr, "custom_element: %s%s%s\n", error.file, error.file[0] ? ": " : "", error.message);
    return EXIT_FAILED;
}

int main(int argc, char **argv) { return finish("custom_element", program(argc, argv), EXIT_FAILED); }
