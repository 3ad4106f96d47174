/* cut_study: how fast the errors of cuts through elements fall, beside those of meshes made for the cut.
 *
 *     cut_study [OPTIONS]      cut_study --help lists them
 *
 * The beam of Suwelack (2014), section 8.1.4: 0.2 x 0.03 x 0.06 m, E 300 kPa, nu 0.35, 1000 kg/m3, clamped at x = 0 and
 * cut in its middle from above to half of its height. It sags under its weight, and is stretched by 2 mm. Compared are
 * meshes with faces in the cut and an edge at its front, whose nodes are doubled by hand, and meshes whose elements a
 * blade goes through (sb_cut): a cut that lags behind the blade up to whole elements, and one whose front is glued.
 * tet4 and tet10. Beside the tet4 stand branch functions at the front (crack_beam.h; 8.2), which sb_cut has not: they
 * are for studies. Measured are the sag of the end face, how far the cut opens at the top edge, and the force that
 * stretches, beside those of conforming tet10 meshes of up to 175,000 unknowns, extrapolated: 34.7 mm, 6.09 mm and
 * 3.79 N, each to half a percent. Errors below that are noise.
 *
 * The second body is the edge-cracked plate, 1 x 2 with a crack of 0.5 from its side, pulled in plane strain: its
 * stress intensity, from energies at cracks that are two elements shorter and longer, beside F sqrt(pi a) (Tada, Paris
 * and Irwin). In single precision it is left out: differences of energies are lost there.
 *
 * The third is that plate in the plane, of linear triangles, for what sb_cut does not do: branch functions at the
 * front (crack_plane.h), continuous or in triangles that stand apart and are embedded by a discontinuous Galerkin
 * derivative (8.3), beside jumps alone and beside a mesh made for the crack. Measured is the energy that the crack
 * adds, beside 1.388 (of F, and extrapolated), also over what jumps between those triangles cost.
 *
 * Written are tables with the order of each curve, the same numbers as CSV and charts (SVG); the same on every
 * machine. Exit status: 0, 2 wrong usage or a file that cannot be written, 3 a solve failed or memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "crack_beam.h"
#include "crack_plane.h"
#include "options.h"
#include "plot.h"

#define REAL(x) ((sb_real)(x)) /* everything here computes in double, the body in sb_real */

static const char *const program_name = "cut_study";
static const double beam_length = 0.2, beam_width = 0.03, beam_height = 0.06; /* m */
static const double cut_at = 0.1, cut_to = 0.03;                              /* x, z of the front (m) */
static const double stretch_by = 0.002;                                       /* m */
static const double plate_height = 2, crack_length = 0.5;                     /* of the plate's width */
static const double crack_energy = 1.388;                                     /* per E = traction = width = 1 */
static const double crack_beta = 10; /* what jumps between embedded triangles cost (8.3.5) */
enum { USAGE = 2, FAILED = 3, SERIES = 8, SIZES = 3, VALUES = 3, CRACKS = 7, COSTS = 6, MOST_PATH = 900 };

static const char *const value_names[VALUES] = {"sag", "opening", "force"};
static const double references[VALUES] = {34.7, 6.09, 3.79}; /* mm, mm, N */

/* How the beam is cut. */
typedef enum cut_kind { CONFORMING = 0, LAG = 1, GLUE = 2, BRANCH = 3 } cut_kind;

typedef struct settings {
    const char *out;
    int quick, lattice, branch, help;
} settings;

/* A curve: one way to cut, of one element. */
typedef struct series {
    const char *name;
    sb_element_type element;
    cut_kind kind;
    double reach; /* of branch functions from the front (m) */
    int count;
    double nodes[SIZES], sizes[SIZES];                   /* or a third of the unknowns; h (mm) */
    double values[VALUES][SIZES], errors[VALUES][SIZES]; /* mm, mm, N; percent */
    int iterations[SIZES];                               /* of conjugate gradients, for the sag */
    int plate_count;
    double plate_nodes[SIZES], plate_cells[SIZES];      /* cells: across */
    double intensities[SIZES], intensity_errors[SIZES]; /* of the sharp one; percent */
} series;

/* A curve of the plate in the plane: one way to take the crack. */
typedef struct crack_series {
    const char *name;
    crack_kind kind;
    double reach; /* of branch functions, beside those of the triangle at the tip */
    int count;
    double cells[SIZES], unknowns[SIZES], energies[SIZES], errors[SIZES]; /* errors: percent */
} crack_series;

/* A curve of that plate over what jumps between embedded triangles cost. */
typedef struct cost_series {
    const char *name;
    double reach;
    double betas[COSTS], energies[COSTS], errors[COSTS]; /* errors: percent */
} cost_series;

/* Where a body is cut: a plane across one axis, on one side of its front. */
typedef struct cut_place {
    int is_plate;
    double front; /* z of the beam's, x of the plate's */
} cut_place;

typedef struct scene {
    sb_mesh mesh;
    sb_body *body;
    sb_cut *cut;
} scene;

static int complain(const char *about, const char *what, int status)
{
    progress_end();
    fprintf(stderr, "%s: %s: %s\n", program_name, about, what);
    return status;
}

/* ---- the beam -------------------------------------------------------------------------------------------------- */

/* Cells along x, y and z: cuts by hand need planes of nodes in the cut and at its front, the others have both inside of
 * elements. */
static void cells_of(const series *of, int size, int cells[3])
{
    static const int by_hand[SIZES][3] = {{10, 2, 4}, {20, 4, 8}, {30, 5, 10}};
    static const int through[SIZES][3] = {{11, 2, 3}, {21, 4, 7}, {31, 5, 9}};
    memcpy(cells, of->kind == CONFORMING ? by_hand[size] : through[size], 3 * sizeof *cells);
}

static int is_in_cut(const cut_place *cut, sb_vec3 x)
{
    if (cut->is_plate)
        return fabs((double)x.y - plate_height / 2) < 1e-9 && (double)x.x < cut->front - 1e-9;
    return fabs((double)x.x - cut_at) < 1e-9 && (double)x.z > cut->front + 1e-9;
}

static int is_beyond_cut(const cut_place *cut, sb_vec3 x)
{
    return cut->is_plate ? (double)x.y > plate_height / 2 : (double)x.x > cut_at;
}

/* Doubles the nodes in the cut: elements beyond it take the copies. 0: no memory. */
static int cut_by_hand(sb_mesh *mesh, const cut_place *cut)
{
    int width = sb_mesh_element_width(mesh), copies = 0;
    int *copy = (int *)calloc((size_t)mesh->node_count, sizeof(int));
    sb_vec3 *nodes;
    for (int i = 0; i < mesh->node_count && copy; i++)
        copies += is_in_cut(cut, mesh->nodes[i]);
    nodes = (sb_vec3 *)realloc(mesh->nodes, (size_t)(mesh->node_count + copies) * sizeof *nodes);
    if (!copy || !nodes) {
        mesh->nodes = nodes ? nodes : mesh->nodes;
        free(copy);
        return 0;
    }
    mesh->nodes = nodes;
    for (int i = 0, end = mesh->node_count; i < end; i++)
        if (is_in_cut(cut, nodes[i])) {
            copy[i] = mesh->node_count++;
            nodes[copy[i]] = nodes[i];
        }
    for (int e = 0; e < mesh->element_count; e++) {
        int *element = mesh->elements + (size_t)e * (size_t)width;
        sb_vec3 middle = sb_v3(0, 0, 0);
        for (int a = 0; a < 4; a++)
            middle = sb_v3_madd(middle, REAL(0.25), nodes[element[a]]);
        for (int a = 0; a < width && is_beyond_cut(cut, middle); a++)
            if (is_in_cut(cut, nodes[element[a]]) && copy[element[a]])
                element[a] = copy[element[a]];
    }
    free(copy);
    return 1;
}

/* Cuts with a blade's edge that goes from one place to another. */
static int cut_through(scene *s, cut_kind kind, int lattice, const sb_vec3 from[2], const sb_vec3 to[2])
{
    sb_cut_def def = sb_default_cut_def();
    sb_error error;
    int stroke = -1;
    def.body = s->body;
    def.lattice = lattice;
    def.front = kind == GLUE ? SB_CUT_GLUE : SB_CUT_LAG;
    if (sb_cut_create(&def, &s->cut, &error) != SB_OK || sb_cut_begin(s->cut, from, 2, &stroke, &error) != SB_OK ||
        sb_cut_move(s->cut, stroke, to, NULL, &error) != SB_OK)
        return complain("the cut", error.message, FAILED);
    return 0;
}

/* Across the beam, down to the front; a hair off the middles of edges. */
static int cut_beam(scene *s, cut_kind kind, int lattice)
{
    sb_vec3 from[2], to[2];
    from[0] = sb_v3(REAL(cut_at + 2e-5), REAL(-0.01), REAL(beam_height + 0.005));
    from[1] = sb_v3(REAL(cut_at + 2e-5), REAL(beam_width + 0.01), REAL(beam_height + 0.005));
    memcpy(to, from, sizeof to);
    to[0].z = to[1].z = REAL(cut_to);
    return cut_through(s, kind, lattice, from, to);
}

static int hold_plane(scene *s, double x, sb_real by, const char *what)
{
    sb_vec3 way = sb_v3(by, 0, 0);
    for (int i = 0; i < s->mesh.node_count; i++)
        if (fabs((double)s->mesh.nodes[i].x - x) < 1e-9 && sb_body_prescribe(s->body, &i, 1, SB_XYZ, &way, 1) != SB_OK)
            return complain(what, "is not held", FAILED);
    return 0;
}

static int make_scene(const settings *set, const series *of, int size, scene *s)
{
    sb_body_def def = sb_default_body_def();
    cut_place cut = {0, 0};
    sb_error error;
    int cells[3], status = 0;
    cut.front = cut_to;
    cells_of(of, size, cells);
    memset(s, 0, sizeof *s);
    if (sb_mesh_beam(of->element, cells[0], cells[1], cells[2],
                     sb_v3(REAL(beam_length), REAL(beam_width), REAL(beam_height)), NULL, &s->mesh, &error) != SB_OK)
        return complain("the mesh", error.message, FAILED);
    if (of->kind == CONFORMING && !cut_by_hand(&s->mesh, &cut))
        return complain("the mesh", "no memory", FAILED);
    def.mesh = &s->mesh;
    def.material = sb_material_linear(REAL(300e3), REAL(0.35), 1000);
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.slack = of->kind == CONFORMING ? 0 : 1;
    if (sb_body_create(&def, &s->body, &error) != SB_OK)
        return complain("the body", error.message, FAILED);
    status = hold_plane(s, 0, 0, "the clamped end");
    return status || of->kind == CONFORMING ? status : cut_beam(s, of->kind, set->lattice);
}

static void free_scene(scene *s)
{
    sb_cut_destroy(s->cut);
    sb_body_destroy(s->body);
    sb_mesh_free(&s->mesh);
}

/* ---- what is measured ------------------------------------------------------------------------------------------ */

static int solve(scene *s, sb_step_info *info)
{
    sb_static_options options = sb_default_static_options();
    options.tolerance = sizeof(sb_real) == 4 ? REAL(1e-4) : REAL(1e-9);
    return sb_body_solve_static(s->body, &options, info) == SB_OK ? 0
                                                                  : complain("a solve", info->error.message, FAILED);
}

static double mean_sag(const scene *s)
{
    double sum = 0;
    int count = 0;
    for (int i = 0; i < s->mesh.node_count; i++)
        if ((double)s->mesh.nodes[i].x > beam_length - 1e-9) {
            sum -= (double)sb_body_displacements(s->body)[i].z;
            count++;
        }
    return sum / count;
}

/* Displacement along x of the material at a point. */
static double x_at(const scene *s, sb_vec3 point)
{
    sb_real best[3] = {0, 0, 0}, deepest = -SB_REAL_MAX, shape[SB_MAX_ELEMENT_NODES];
    int width = sb_mesh_element_width(&s->mesh), found = 0;
    const int *cell;
    double sum = 0;
    for (int e = 0; e < s->mesh.element_count; e++) {
        const int *at = s->mesh.elements + (size_t)e * (size_t)width;
        sb_vec3 o = s->mesh.nodes[at[0]];
        sb_mat3 edges = sb_m3_columns(sb_v3_sub(s->mesh.nodes[at[1]], o), sb_v3_sub(s->mesh.nodes[at[2]], o),
                                      sb_v3_sub(s->mesh.nodes[at[3]], o));
        sb_vec3 xi = sb_m3_apply(sb_m3_inverse(edges), sb_v3_sub(point, o));
        sb_real depth =
            (sb_real)fmin(fmin((double)xi.x, (double)xi.y), fmin((double)xi.z, 1 - (double)(xi.x + xi.y + xi.z)));
        if (!(depth > deepest))
            continue;
        deepest = depth;
        found = e;
        best[0] = xi.x, best[1] = xi.y, best[2] = xi.z;
    }
    cell = sb_body_cell_nodes(s->body, s->cut ? sb_body_find_cell(s->body, found, best) : found);
    sb_element_shape(s->mesh.element_type, best, shape, NULL);
    for (int a = 0; a < width; a++)
        sum += (double)shape[a] * (double)sb_body_displacements(s->body)[cell[a]].x;
    return sum;
}

/* How far the cut is open at the top edge, on the mean over the beam's width. */
static double mean_opening(const scene *s)
{
    enum { PLACES = 9 };
    double sum = 0, x = cut_at + (s->cut ? 2e-5 : 0), z = beam_height - 1e-6;
    for (int i = 0; i < PLACES; i++) {
        double y = beam_width * (i + 0.5) / (int)PLACES;
        sum += x_at(s, sb_v3(REAL(x + 1e-5), REAL(y), REAL(z))) - x_at(s, sb_v3(REAL(x - 1e-5), REAL(y), REAL(z)));
    }
    return sum / (int)PLACES;
}

static int stretch(scene *s, double *force)
{
    sb_step_info info;
    double sum = 0;
    int status = hold_plane(s, beam_length, REAL(stretch_by), "the end that is drawn");
    if (sb_body_set_gravity(s->body, sb_v3(0, 0, 0)) != SB_OK)
        return complain("gravity", "is not taken", FAILED);
    if (!status)
        status = solve(s, &info);
    for (int i = 0; i < s->mesh.node_count && !status; i++)
        if ((double)s->mesh.nodes[i].x < 1e-9)
            sum += (double)sb_body_reactions(s->body)[i].x;
    *force = fabs(sum);
    return status;
}

/* The beam by branch functions, in double whatever bodies compute in. */
static int measure_branch(series *of, int size)
{
    crack_beam beam = {NULL, 0, NULL, 0, beam_length, cut_at + 2e-5, cut_to, of->reach, 300e3, 0.35, 1000 * 9.81, 0};
    crack_beam_result sags, stretched;
    sb_mesh mesh;
    double(*nodes)[3];
    int cells[3], done;
    cells_of(of, size, cells);
    if (sb_mesh_beam(SB_TET4, cells[0], cells[1], cells[2],
                     sb_v3(REAL(beam_length), REAL(beam_width), REAL(beam_height)), NULL, &mesh, NULL) != SB_OK)
        return complain("the mesh", "no memory", FAILED);
    nodes = (double(*)[3])malloc((size_t)mesh.node_count * sizeof *nodes);
    for (int i = 0; i < mesh.node_count && nodes; i++) {
        nodes[i][0] = (double)mesh.nodes[i].x;
        nodes[i][1] = (double)mesh.nodes[i].y;
        nodes[i][2] = (double)mesh.nodes[i].z;
    }
    beam.nodes = (const double(*)[3])nodes;
    beam.node_count = mesh.node_count;
    beam.tets = (const int(*)[4])mesh.elements;
    beam.tet_count = mesh.element_count;
    done = nodes && crack_beam_solve(&beam, &sags);
    beam.weight = 0;
    beam.stretch = stretch_by;
    done = done && crack_beam_solve(&beam, &stretched);
    free(nodes);
    sb_mesh_free(&mesh);
    if (!done)
        return complain("branch functions", "no memory, or not positive definite", FAILED);
    of->nodes[size] = sags.unknowns / 3.0;
    of->values[0][size] = 1e3 * sags.sag;
    of->values[1][size] = 1e3 * sags.opening;
    of->values[2][size] = stretched.force;
    return 0;
}

static int measure_body(const settings *set, series *of, int size)
{
    scene s;
    sb_step_info info;
    int status = make_scene(set, of, size, &s);
    if (!status)
        status = solve(&s, &info);
    if (!status) {
        of->iterations[size] = info.pcg_iterations;
        of->values[0][size] = 1e3 * mean_sag(&s);
        of->values[1][size] = 1e3 * mean_opening(&s);
        status = stretch(&s, &of->values[2][size]);
    }
    if (!status)
        of->nodes[size] = sb_body_node_count(s.body);
    free_scene(&s);
    return status;
}

static int measure(const settings *set, series *of, int size)
{
    int cells[3], status = of->kind == BRANCH ? measure_branch(of, size) : measure_body(set, of, size);
    if (status)
        return status;
    cells_of(of, size, cells);
    of->sizes[size] = 1e3 * beam_length / cells[0];
    for (int v = 0; v < VALUES; v++)
        of->errors[v][size] = 100 * fabs(of->values[v][size] / references[v] - 1);
    of->count = size + 1;
    return 0;
}

/* ---- the edge-cracked plate ------------------------------------------------------------------------------------ */

/* Cells across the plate; along it there are twice as many where the cut goes between them, one more where through. */
static int plate_cells_of(const series *of, int size)
{
    static const int by_hand[SIZES] = {10, 16, 20}, through[SIZES] = {11, 15, 21};
    return of->kind == CONFORMING ? by_hand[size] : through[size];
}

/* Pulls the ends of the plate apart by 1 N/m2. */
static int pull_plate(scene *s)
{
    const sb_mesh *mesh = &s->mesh;
    for (int e = 0; e < mesh->element_count; e++)
        for (int face = 0; face < 4; face++) {
            const int *element = mesh->elements + (size_t)e * (size_t)sb_mesh_element_width(mesh);
            int local[SB_MAX_FACE_NODES], nodes[3];
            double y[3];
            sb_element_face(SB_TET4, face, local, NULL);
            for (int k = 0; k < 3; k++) {
                nodes[k] = element[local[k]];
                y[k] = (double)mesh->nodes[nodes[k]].y;
            }
            if (fabs(y[0] - y[1]) > 1e-9 || fabs(y[0] - y[2]) > 1e-9 ||
                (fabs(y[0]) > 1e-9 && fabs(y[0] - plate_height) > 1e-9))
                continue;
            if (sb_body_add_traction(s->body, nodes, 1, 3, sb_v3(0, y[0] > 1 ? 1 : -1, 0), NULL) != SB_OK)
                return complain("the plate", "is not pulled", FAILED);
        }
    return 0;
}

/* Plane strain, and nothing else held but motions of the whole. */
static int hold_plate(scene *s)
{
    int status = 0;
    for (int i = 0; i < s->mesh.node_count && !status; i++) {
        double x = (double)s->mesh.nodes[i].x, y = (double)s->mesh.nodes[i].y, z = (double)s->mesh.nodes[i].z;
        int at_corner = x > 1 - 1e-9 && z < 1e-9, axes = SB_Z;
        if (at_corner && y < 1e-9)
            axes |= SB_X | SB_Y;
        if (at_corner && y > plate_height - 1e-9)
            axes |= SB_X;
        if (sb_body_fix_nodes(s->body, &i, 1, axes) != SB_OK)
            status = complain("the plate", "is not held", FAILED);
    }
    return status;
}

static int make_plate(const settings *set, const series *of, int n, double crack, scene *s)
{
    sb_body_def def = sb_default_body_def();
    sb_error error;
    double depth = 1.0 / n;
    sb_vec3 from[2], to[2];
    cut_place cut = {1, 0};
    int status;
    cut.front = crack;
    memset(s, 0, sizeof *s);
    if (sb_mesh_beam(of->element, n, of->kind == CONFORMING ? 2 * n : 2 * n + 1, 1,
                     sb_v3(1, REAL(plate_height), REAL(depth)), NULL, &s->mesh, &error) != SB_OK)
        return complain("the mesh", error.message, FAILED);
    if (of->kind == CONFORMING && !cut_by_hand(&s->mesh, &cut))
        return complain("the mesh", "no memory", FAILED);
    def.mesh = &s->mesh;
    def.material = sb_material_linear(1, REAL(0.3), 1);
    def.slack = of->kind == CONFORMING ? 0 : 1;
    if (sb_body_create(&def, &s->body, &error) != SB_OK)
        return complain("the body", error.message, FAILED);
    from[0] = sb_v3(REAL(-0.1), REAL(plate_height / 2), REAL(-0.1));
    from[1] = sb_v3(REAL(-0.1), REAL(plate_height / 2), REAL(depth + 0.1));
    memcpy(to, from, sizeof to);
    to[0].x = to[1].x = REAL(crack);
    status = hold_plate(s);
    if (!status)
        status = pull_plate(s);
    return status || of->kind == CONFORMING ? status : cut_through(s, of->kind, set->lattice, from, to);
}

/* Elastic energy per thickness. */
static int plate_energy(const settings *set, series *of, int size, double crack, double *found)
{
    int n = plate_cells_of(of, size), status;
    sb_step_info info;
    sb_energy energy;
    scene s;
    status = make_plate(set, of, n, crack, &s);
    if (!status)
        status = solve(&s, &info);
    if (!status && sb_body_energy(s.body, &energy) != SB_OK)
        status = complain("the plate", "has no energy", FAILED);
    if (!status) {
        *found = (double)energy.elastic * n;
        of->plate_nodes[size] = sb_body_node_count(s.body);
    }
    free_scene(&s);
    return status;
}

/* K^2 (1 - nu^2)/E at a crack of length a: K = F sqrt(pi a). */
static double sharp_rate(double a)
{
    double f = 1.122 - 0.231 * a + 10.55 * a * a - 21.71 * a * a * a + 30.382 * a * a * a * a;
    return f * f * 3.14159265358979 * a * (1 - 0.3 * 0.3);
}

/* The stress intensity over the sharp one, both as means over four elements. */
static int measure_plate(const settings *set, series *of, int size)
{
    enum { PLACES = 100 };
    double h = 1.0 / plate_cells_of(of, size), shorter = 0, longer = 0, sharp = 0;
    int status = plate_energy(set, of, size, crack_length - 2 * h, &shorter);
    if (!status)
        status = plate_energy(set, of, size, crack_length + 2 * h, &longer);
    if (status)
        return status;
    for (int i = 0; i < PLACES; i++)
        sharp += sharp_rate(crack_length + 4 * h * ((i + 0.5) / (int)PLACES - 0.5)) / (int)PLACES;
    of->plate_cells[size] = plate_cells_of(of, size);
    of->intensities[size] = sqrt((longer - shorter) / (4 * h) / sharp);
    of->intensity_errors[size] = 100 * fabs(of->intensities[size] - 1);
    of->plate_count = size + 1;
    return 0;
}

/* ---- branch functions ------------------------------------------------------------------------------------------- */

static void name_cracks(crack_series cracks[CRACKS])
{
    static const char *const names[CRACKS] = {
        "by hand",           "jumps alone",         "branch at the tip",  "branch within 0.1",
        "branch within 0.2", "embedded at the tip", "embedded within 0.2"};
    static const crack_kind kinds[CRACKS] = {CRACK_BY_HAND, CRACK_HEAVISIDE, CRACK_BRANCH,  CRACK_BRANCH,
                                             CRACK_BRANCH,  CRACK_EMBEDDED,  CRACK_EMBEDDED};
    static const double reaches[CRACKS] = {0, 0, 0, 0.1, 0.2, 0, 0.2};
    memset(cracks, 0, CRACKS * sizeof *cracks);
    for (int c = 0; c < CRACKS; c++) {
        cracks[c].name = names[c];
        cracks[c].kind = kinds[c];
        cracks[c].reach = reaches[c];
    }
}

static int solve_crack(const crack_plane *plate, crack_plane_result *found)
{
    return crack_plane_solve(plate, found) ? 0 : complain("the plate in the plane", "no memory", FAILED);
}

static double crack_error(double energy) { return 100 * fabs(energy / crack_energy - 1); }

static int measure_cracks(const settings *set, crack_series cracks[CRACKS])
{
    static const int by_hand[SIZES] = {10, 20, 40}, through[SIZES] = {11, 21, 41};
    int sizes = set->quick ? 2 : SIZES, status = 0;
    for (crack_series *of = cracks; of < cracks + CRACKS; of++)
        for (int k = 0; k < sizes && !status; k++) {
            crack_plane plate = {of->kind, 0, crack_length, of->reach, crack_beta};
            crack_plane_result found = {0, 0, 0};
            plate.cells = of->kind == CRACK_BY_HAND ? by_hand[k] : through[k];
            status = solve_crack(&plate, &found);
            of->cells[k] = plate.cells;
            of->unknowns[k] = found.unknowns;
            of->energies[k] = found.energy;
            of->errors[k] = crack_error(found.energy);
            of->count = k + 1;
        }
    return status;
}

/* From triangles that hardly hold together to such as are continuous, which leaves no branch function at a tip alone.
 */
static int measure_costs(cost_series costs[2])
{
    static const double betas[COSTS] = {0.1, 1, 10, 100, 1000, 10000};
    static const char *const names[2] = {"at the tip", "within 0.2"};
    int status = 0;
    for (int c = 0; c < 2; c++) {
        costs[c].name = names[c];
        costs[c].reach = c ? 0.2 : 0;
        for (int k = 0; k < COSTS && !status; k++) {
            crack_plane plate = {CRACK_EMBEDDED, 21, crack_length, costs[c].reach, betas[k]};
            crack_plane_result found = {0, 0, 0};
            status = solve_crack(&plate, &found);
            costs[c].betas[k] = betas[k];
            costs[c].energies[k] = found.energy;
            costs[c].errors[k] = crack_error(found.energy);
        }
    }
    return status;
}

static double crack_order(const crack_series *of)
{
    int last = of->count - 1;
    return log(of->errors[0] / of->errors[last]) / log(of->cells[last] / of->cells[0]);
}

static void print_cracks(const crack_series cracks[CRACKS])
{
    printf("crack in the plane  cells unknowns   energy    error\n");
    for (const crack_series *of = cracks; of < cracks + CRACKS; of++) {
        for (int k = 0; k < of->count; k++)
            printf("%-19s %5.0f  %7.0f  %7.4f %6.2f %%\n", k ? "" : of->name, of->cells[k], of->unknowns[k],
                   of->energies[k], of->errors[k]);
        printf("%-19s order            %14.2f\n", "", crack_order(of));
    }
}

static void print_costs(const cost_series costs[2])
{
    printf("\nembedded, 21 cells, at a cost of jumps of");
    for (int k = 0; k < COSTS; k++)
        printf(" %8g", costs[0].betas[k]);
    for (int c = 0; c < 2; c++) {
        printf("\n%-41s", costs[c].name);
        for (int k = 0; k < COSTS; k++)
            printf(" %6.2f %%", costs[c].errors[k]);
    }
    printf("\n");
}

static int write_cracks(const settings *set, const crack_series cracks[CRACKS])
{
    char path[MOST_PATH + 32];
    sb_output out;
    snprintf(path, sizeof path, "%s_branch.csv", set->out);
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return complain(path, "cannot be written", USAGE);
    fprintf(out.file, "crack,cells,unknowns,energy,error\n");
    for (const crack_series *of = cracks; of < cracks + CRACKS; of++)
        for (int k = 0; k < of->count; k++)
            fprintf(out.file, "%s,%.0f,%.0f,%.6f,%.5f\n", of->name, of->cells[k], of->unknowns[k], of->energies[k],
                    of->errors[k] / 100);
    return sb_output_close(&out, NULL) == SB_OK ? 0 : complain(path, "cannot be written", USAGE);
}

static int write_costs(const settings *set, const cost_series costs[2])
{
    char path[MOST_PATH + 32];
    sb_output out;
    snprintf(path, sizeof path, "%s_beta.csv", set->out);
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return complain(path, "cannot be written", USAGE);
    fprintf(out.file, "embedded,beta,energy,error\n");
    for (int c = 0; c < 2; c++)
        for (int k = 0; k < COSTS; k++)
            fprintf(out.file, "%s,%g,%.6f,%.5f\n", costs[c].name, costs[c].betas[k], costs[c].energies[k],
                    costs[c].errors[k] / 100);
    return sb_output_close(&out, NULL) == SB_OK ? 0 : complain(path, "cannot be written", USAGE);
}

static int draw_cracks(const settings *set, const crack_series cracks[CRACKS], const cost_series costs[2])
{
    plot_panel *over_beta;
    char path[MOST_PATH + 32];
    plot p;
    plot_begin(&p, "An edge-cracked plate, linear triangles: branch functions at the front");
    for (int over_unknowns = 0; over_unknowns < 2; over_unknowns++) {
        plot_panel *panel = plot_add_panel(&p, "energy of the crack", over_unknowns ? "unknowns" : "cells across",
                                           "relative error (%)");
        panel->log_x = panel->log_y = 1;
        for (const crack_series *of = cracks; of < cracks + CRACKS; of++) {
            plot_curve *curve =
                plot_add_curve(panel, of->name, over_unknowns ? of->unknowns : of->cells, of->errors, of->count);
            curve->markers = 1;
            curve->dashed = of->kind == CRACK_BY_HAND;
        }
    }
    over_beta = plot_add_panel(&p, "embedded branch functions, 21 cells", "cost of jumps (beta)", "relative error (%)");
    over_beta->log_x = over_beta->log_y = 1;
    for (int c = 0; c < 2; c++)
        plot_add_curve(over_beta, costs[c].name, costs[c].betas, costs[c].errors, COSTS)->markers = 1;
    snprintf(path, sizeof path, "%s_branch.svg", set->out);
    return plot_save_svg(&p, path) ? 0 : complain(path, "cannot be written", USAGE);
}

static int study_cracks(const settings *set)
{
    crack_series cracks[CRACKS];
    cost_series costs[2];
    int status;
    name_cracks(cracks);
    status = measure_cracks(set, cracks);
    if (!status)
        status = measure_costs(costs);
    if (status)
        return status;
    print_cracks(cracks);
    print_costs(costs);
    status = write_cracks(set, cracks);
    if (!status)
        status = write_costs(set, costs);
    return status ? status : draw_cracks(set, cracks, costs);
}

/* Power of h by which an error falls from the coarsest mesh to the finest. */
static double order(const series *of, int value)
{
    int last = of->count - 1;
    return log(of->errors[value][0] / of->errors[value][last]) / log(of->sizes[0] / of->sizes[last]);
}

/* ---- files ----------------------------------------------------------------------------------------------------- */

static void print_series(const series *of)
{
    for (int k = 0; k < of->count; k++) {
        char iterations[16] = "-"; /* factored */
        if (of->kind != BRANCH)
            snprintf(iterations, sizeof iterations, "%d", of->iterations[k]);
        printf("%-18s %5.1f %7.0f  %7.3f %6.2f %%  %7.3f %6.2f %%  %7.3f %6.2f %%  %4s\n", k ? "" : of->name,
               of->sizes[k], of->nodes[k], of->values[0][k], of->errors[0][k], of->values[1][k], of->errors[1][k],
               of->values[2][k], of->errors[2][k], iterations);
    }
    if (of->count > 1)
        printf("%-18s order         %16.2f  %16.2f  %16.2f\n", "", order(of, 0), order(of, 1), order(of, 2));
}

static void print_plate(const series *of)
{
    for (int k = 0; k < of->plate_count; k++)
        printf("%-18s %5.0f %7.0f  %7.4f %6.2f %%\n", k ? "" : of->name, of->plate_cells[k], of->plate_nodes[k],
               of->intensities[k], of->intensity_errors[k]);
}

static int write_plate(const settings *set, const series *curves)
{
    char path[MOST_PATH + 32];
    sb_output out;
    snprintf(path, sizeof path, "%s_plate.csv", set->out);
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return complain(path, "cannot be written", USAGE);
    fprintf(out.file, "cut,cells,nodes,intensity,error\n");
    for (const series *c = curves; c < curves + SERIES; c++)
        for (int k = 0; k < c->plate_count; k++)
            fprintf(out.file, "%s,%.0f,%.0f,%.5f,%.5f\n", c->name, c->plate_cells[k], c->plate_nodes[k],
                    c->intensities[k], c->intensity_errors[k] / 100);
    return sb_output_close(&out, NULL) == SB_OK ? 0 : complain(path, "cannot be written", USAGE);
}

static int write_table(const settings *set, const series *curves)
{
    char path[MOST_PATH + 32];
    sb_output out;
    snprintf(path, sizeof path, "%s.csv", set->out);
    if (sb_output_open(&out, path, NULL) != SB_OK)
        return complain(path, "cannot be written", USAGE);
    fprintf(out.file, "cut,h_mm,nodes,sag_mm,opening_mm,force_N,sag_error,opening_error,force_error,iterations\n");
    for (const series *c = curves; c < curves + SERIES; c++)
        for (int k = 0; k < c->count; k++)
            fprintf(out.file, "%s,%.4f,%.0f,%.4f,%.4f,%.4f,%.4f,%.4f,%.4f,%d\n", c->name, c->sizes[k], c->nodes[k],
                    c->values[0][k], c->values[1][k], c->values[2][k], c->errors[0][k] / 100, c->errors[1][k] / 100,
                    c->errors[2][k] / 100, c->iterations[k]);
    return sb_output_close(&out, NULL) == SB_OK ? 0 : complain(path, "cannot be written", USAGE);
}

static int draw_chart(const settings *set, const series *curves)
{
    static const char *const titles[VALUES] = {"under its weight: the end sinks", "under its weight: the cut opens",
                                               "stretched by 2 mm: force"};
    char path[MOST_PATH + 32];
    plot p;
    plot_begin(&p, "A beam cut to half of its height, and a plate with a crack");
    for (int v = 0; v < VALUES; v++) {
        plot_panel *panel = plot_add_panel(&p, titles[v], "nodes", "relative error (%)");
        panel->log_x = panel->log_y = 1;
        for (const series *c = curves; c < curves + SERIES; c++) {
            plot_curve *curve = plot_add_curve(panel, c->name, c->nodes, c->errors[v], c->count);
            curve->markers = 1;
            curve->dashed = c->kind == CONFORMING;
        }
    }
    if (curves[0].plate_count) {
        plot_panel *panel = plot_add_panel(&p, "edge-cracked plate: stress intensity", "nodes", "relative error (%)");
        panel->log_x = panel->log_y = 1;
        for (const series *c = curves; c < curves + SERIES; c++) {
            plot_curve *curve = plot_add_curve(panel, c->name, c->plate_nodes, c->intensity_errors, c->plate_count);
            curve->markers = 1;
            curve->dashed = c->kind == CONFORMING;
        }
    }
    snprintf(path, sizeof path, "%s.svg", set->out);
    return plot_save_svg(&p, path) ? 0 : complain(path, "cannot be written", USAGE);
}

/* ---- the study ------------------------------------------------------------------------------------------------- */

static void name_series(series curves[SERIES])
{
    static const char *const names[SERIES] = {"tet4 by hand",   "tet4 lag",      "tet4 glue", "tet4 branch",
                                              "tet4 branch 20", "tet10 by hand", "tet10 lag", "tet10 glue"};
    static const cut_kind kinds[SERIES] = {CONFORMING, LAG, GLUE, BRANCH, BRANCH, CONFORMING, LAG, GLUE};
    memset(curves, 0, SERIES * sizeof *curves);
    for (int c = 0; c < SERIES; c++) {
        curves[c].name = names[c];
        curves[c].element = strncmp(names[c], "tet10", 5) ? SB_TET4 : SB_TET10;
        curves[c].kind = kinds[c];
        curves[c].reach = c == 3 ? 1e-6 : 0.02; /* at the front, or within 20 mm of it */
    }
}

static int measure_all(const settings *set, series curves[SERIES])
{
    int sizes = set->quick ? 2 : SIZES, status = 0, has_plate = sizeof(sb_real) == 8;
    for (int c = 0; c < SERIES; c++)
        for (int k = 0; k < sizes && !status; k++) {
            progress_show((double)(c * sizes + k) / ((int)SERIES * sizes), curves[c].name);
            status = measure(set, curves + c, k);
            if (!status && has_plate && curves[c].kind != BRANCH)
                status = measure_plate(set, curves + c, k);
        }
    progress_end();
    return status;
}

static int run_all(const settings *set)
{
    series curves[SERIES];
    int last = set->quick ? 1 : SIZES - 1, status;
    name_series(curves);
    status = measure_all(set, curves);
    if (status)
        return status;
    printf("cut                h/mm   nodes   sag/mm    error  opening    error  force/N    error  iterations\n");
    for (int c = 0; c < SERIES; c++)
        print_series(curves + c);
    printf("\nplate            cells   nodes       K    error\n");
    for (int c = 0; c < SERIES; c++)
        print_plate(curves + c);
    status = write_table(set, curves);
    if (!status && curves[0].plate_count)
        status = write_plate(set, curves);
    if (!status)
        status = draw_chart(set, curves);
    printf("\n");
    if (!status)
        status = study_cracks(set);
    if (status)
        return status;
    printf("written     %s.csv, %s.svg, %s_branch.csv, %s_branch.svg\n", set->out, set->out, set->out, set->out);
    for (int v = 0; v < VALUES; v++)
        printf("%s_order=%.2f ", value_names[v], order(curves + SERIES - 1, v));
    printf("sag_mm=%.3f opening_mm=%.3f force_N=%.3f intensity=%.4f\n", curves[SERIES - 1].values[0][last],
           curves[SERIES - 1].values[1][last], curves[SERIES - 1].values[2][last],
           curves[SERIES - 1].plate_count ? curves[SERIES - 1].intensities[last] : 0);
    return 0;
}

static int program(int argc, char **argv)
{
    settings s = {program_name, 0, 2, 0, 0};
    option options[] = {
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &s.out, 0, 0,
         "files are NAME.csv, NAME_plate.csv, NAME.svg, NAME_branch.csv, NAME_beta.csv, NAME_branch.svg"},
        {"--quick", NULL, OPTION_FLAG, &s.quick, NULL, NULL, 0, 0, "two sizes of each in place of three: seconds"},
        {"--branch", NULL, OPTION_FLAG, &s.branch, NULL, NULL, 0, 0,
         "only branch functions at the front of a crack: seconds"},
        {"--lattice", "M", OPTION_INTEGER, &s.lattice, NULL, NULL, 1, 4,
         "places along an element's edge that are cut apart: 1, 2 or 4"},
        {"--help", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, "this text"},
        {"-h", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, NULL},
    };
    enum { OPTIONS = sizeof options / sizeof options[0] };
    if (!options_parse(program_name, options, OPTIONS, NULL, 0, argc, argv))
        return USAGE;
    if (s.help) {
        printf("usage: cut_study [OPTIONS]\n\n"
               "A beam that is cut to half of its height, by hand between elements and through them: errors of its\n"
               "sag, of how the cut opens and of the force that stretches it, over the number of nodes; the stress\n"
               "intensity of a plate with a crack; and both by X-FEM with branch functions at the front.\n\n");
        options_print(options, OPTIONS);
        printf("\nThe last line, of tet10 with a glued front: orders of the errors in h, and the values of the finest "
               "mesh.\n");
        return 0;
    }
    if (strlen(s.out) > MOST_PATH)
        return options_complain(program_name, "-o", "needs a shorter name") ? 0 : USAGE;
    if (s.lattice == 3)
        return options_complain(program_name, "--lattice", "needs 1, 2 or 4") ? 0 : USAGE;
    return s.branch ? study_cracks(&s) : run_all(&s);
}

int main(int argc, char **argv) { return finish(program_name, program(argc, argv), USAGE); }
