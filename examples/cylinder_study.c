/* cylinder_study: immersed grids against conforming meshes: how fast their errors fall with the number of nodes.
 *
 *     cylinder_study [OPTIONS] [CASE]      cylinder_study --help lists them
 *
 * Two neo-Hookean cylinders of radius 5 cm (section 4.8 of Brunet, Simulation of soft tissue for augmented reality,
 * 2020): one of 60 cm, clamped at its base and bent by a traction of 30 Pa on its top; one of 5 cm, both ends clamped,
 * stretched to three times its length. They are solved with conforming tet4 and tet10 meshes, and with a grid that the
 * surface cuts: sparse (level 0), finite cell and weighted cell at several levels. The error is the relative L2 norm of
 * the displacement against a fine mesh of hex20, or against the bent or stretched case of the folder CASE (mesh.vtk and
 * solution.txt). Written are a table, the same numbers as CSV and a chart (SVG). Exit status: 0, 2 wrong usage or a
 * file that cannot be read or written, 3 a solve failed or memory is short. */
#include "system.h"

#define SB_IMPLEMENTATION
#include "softbody.h"

#include "options.h"
#include "plot.h"

enum { EXIT_USAGE = 2, EXIT_SOLVE = 3, MOST_SIZES = 5, SERIES = 8, RINGS = 12, SECTORS = 64 };

static const double pi = 3.14159265358979323846;
static const double radius = 0.05;                         /* m */
static const double c10 = 961.5384615384615, d1 = 0.00048; /* Pa, 1/Pa: E 5000 Pa, nu 0.3 */

typedef struct settings {
    const char *out; /* NAME.svg and NAME.csv */
    int quick, help;
    double void_stiffness;
    int steps; /* load steps */
} settings;

/* One of the two experiments. */
typedef struct experiment {
    const char *name;
    int stretch;
    double length; /* m */
    sb_mesh reference;
    sb_vec3 *solution; /* [reference.node_count] (m) */
} experiment;

/* A curve of the chart: conforming elements, or a grid. */
typedef struct series {
    const char *name;
    sb_element_type element; /* SB_NO_ELEMENT: a grid */
    sb_grid_method method;
    int level;
    int most; /* solve the coarsest so many sizes only; finite cells at high levels take long */
    int count;
    double nodes[MOST_SIZES], errors[MOST_SIZES];
} series;

static int complain(const char *what, const sb_error *error)
{
    progress_end();
    fprintf(stderr, "cylinder_study: %s: %s\n", what, error->message);
    return EXIT_SOLVE;
}

/* ---- shapes ---------------------------------------------------------------------------------------------------- */

/* Signed distance of the cylinder; user is its length. */
static sb_real cylinder_distance(void *user, sb_vec3 p)
{
    double length = *(const double *)user;
    double beside = sqrt((double)(p.x * p.x + p.y * p.y)) - radius,
           beyond = fabs((double)p.z - length / 2) - length / 2;
    if (beside > 0 && beyond > 0)
        return (sb_real)sqrt(beside * beside + beyond * beyond);
    return (sb_real)(beside > beyond ? beside : beyond);
}

/* The top of the cylinder as triangles, whose polygon has the circle's area. 0 when memory is short. */
static int make_top(double length, sb_mesh *top)
{
    double reach = radius * sqrt(2 * pi / (int)SECTORS / sin(2 * pi / (int)SECTORS));
    memset(top, 0, sizeof *top);
    top->element_type = SB_TRI3;
    top->nodes = (sb_vec3 *)malloc((1 + RINGS * SECTORS) * sizeof(sb_vec3));
    top->elements = (int *)malloc(3 * (2 * RINGS - 1) * SECTORS * sizeof(int));
    if (!top->nodes || !top->elements)
        return 0;
    top->nodes[top->node_count++] = sb_v3(0, 0, (sb_real)length);
    for (int r = 1; r <= RINGS; r++)
        for (int s = 0; s < SECTORS; s++) {
            double angle = 2 * pi * s / (int)SECTORS, at = reach * r / (int)RINGS;
            int next = (s + 1) % SECTORS, outer = 1 + (r - 1) * SECTORS, inner = outer - SECTORS;
            int *t = top->elements + 3 * top->element_count;
            top->nodes[top->node_count++] =
                sb_v3((sb_real)(at * cos(angle)), (sb_real)(at * sin(angle)), (sb_real)length);
            t[0] = r == 1 ? 0 : inner + s, t[1] = outer + s, t[2] = outer + next;
            if (r > 1)
                t[3] = inner + s, t[4] = outer + next, t[5] = inner + next;
            top->element_count += r == 1 ? 1 : 2;
        }
    return 1;
}

/* ---- loads ----------------------------------------------------------------------------------------------------- */

/* Clamps the base, and what the experiment does to the other end but for the traction. */
static sb_result hold_ends(const experiment *e, const sb_mesh *mesh, sb_body *body)
{
    sb_vec3 up = sb_v3(0, 0, (sb_real)(2 * e->length));
    sb_result result = SB_OK;
    for (int i = 0; i < mesh->node_count && result == SB_OK; i++) {
        double z = (double)mesh->nodes[i].z;
        if (z < 1e-6 * e->length)
            result = sb_body_fix_nodes(body, &i, 1, SB_XYZ);
        else if (e->stretch && z > (1 - 1e-6) * e->length)
            result = sb_body_prescribe(body, &i, 1, SB_XYZ, &up, 1);
    }
    return result;
}

static sb_vec3 traction(void) { return sb_v3(0, -30, 0); } /* Pa */

/* The traction on a conforming mesh: on the faces at the top. */
static sb_result pull_mesh(const experiment *e, const sb_mesh *mesh, sb_body *body, sb_error *error)
{
    sb_boundary boundary;
    int corners, count = 0, *faces;
    sb_result result = sb_mesh_boundary(mesh, 0, NULL, &boundary, error);
    if (result != SB_OK)
        return result;
    corners = sb_element_corner_count(boundary.surface.element_type);
    faces = (int *)malloc((size_t)(boundary.surface.element_count * corners) * sizeof(int));
    for (int f = 0; f < boundary.surface.element_count && faces; f++) {
        const int *nodes = boundary.surface.elements + f * sb_element_node_count(boundary.surface.element_type);
        int on_top = 1;
        for (int k = 0; k < corners; k++)
            on_top &= (double)mesh->nodes[nodes[k]].z > (1 - 1e-6) * e->length;
        if (on_top)
            memcpy(faces + corners * count++, nodes, (size_t)corners * sizeof(int));
    }
    result = faces ? sb_body_add_traction(body, faces, count, corners, traction(), error) : SB_ERROR_MEMORY;
    free(faces);
    sb_boundary_free(&boundary);
    return result;
}

/* The traction on a grid: through the points of the top. */
static sb_result pull_grid(const experiment *e, const sb_grid *grid, sb_body *body, sb_error *error)
{
    sb_mesh top;
    sb_grid_rows rows;
    sb_vec3 *forces = (sb_vec3 *)calloc((size_t)grid->mesh.node_count, sizeof(sb_vec3)), pull = traction();
    sb_result result = make_top(e->length, &top) && forces ? SB_OK : SB_ERROR_MEMORY;
    memset(&rows, 0, sizeof rows);
    if (result == SB_OK)
        result = sb_grid_map_surface(grid, &top, NULL, 0, NULL, &rows, error);
    if (result == SB_OK)
        sb_grid_add_traction(&rows, &pull, 1, forces);
    for (int i = 0; i < grid->mesh.node_count && result == SB_OK; i++)
        result = sb_body_add_forces(body, &i, 1, forces + i, 1);
    sb_grid_rows_free(&rows);
    free(forces);
    free(top.nodes);
    free(top.elements);
    return result;
}

/* ---- solving --------------------------------------------------------------------------------------------------- */

/* A body of the mesh, or of the grid (its body_mesh), solved; 0, or the exit status with a message printed. */
static int solve(const settings *s, const experiment *e, const sb_mesh *mesh, const sb_grid *grid, sb_body **body)
{
    sb_body_def def = sb_default_body_def();
    sb_static_options options = sb_default_static_options();
    sb_error error;
    sb_step_info info;
    sb_result result;
    memset(&error, 0, sizeof error);
    snprintf(error.message, sizeof error.message, "no memory");
    def.mesh = mesh;
    def.domain = grid ? &grid->domain : NULL;
    def.material = sb_material_neo_hookean_isochoric((sb_real)c10, (sb_real)d1, 1000);
#if defined(SB_USE_OPENMP)
    def.jobs = sb_jobs_openmp();
#endif
    result = sb_body_create(&def, body, &error);
    if (result == SB_OK)
        result = hold_ends(e, mesh, *body);
    if (result == SB_OK && !e->stretch)
        result = grid ? pull_grid(e, grid, *body, &error) : pull_mesh(e, mesh, *body, &error);
    if (result != SB_OK)
        return complain(e->name, &error);
    options.load_steps = s->steps;
    if (sb_body_solve_static(*body, &options, &info) != SB_OK)
        return complain(e->name, &info.error);
    return 0;
}

static int layers(const experiment *e, int across)
{
    int count = (int)(e->length / (2 * radius) * across + 0.5);
    return count < 1 ? 1 : count;
}

/* ---- errors ---------------------------------------------------------------------------------------------------- */

/* |u - u_ref| / |u_ref| over the volume of the reference: u[] are the displacements at its nodes, whose volumes are the
 * weights. */
static double relative_error(const experiment *e, const sb_vec3 *u, const double *volumes)
{
    double sum = 0, size = 0;
    for (int i = 0; i < e->reference.node_count; i++) {
        sb_vec3 d = sb_v3_sub(u[i], e->solution[i]);
        sum += volumes[i] * (double)sb_v3_dot(d, d);
        size += volumes[i] * (double)sb_v3_dot(e->solution[i], e->solution[i]);
    }
    return sqrt(sum / size);
}

static double *node_volumes(const sb_mesh *mesh)
{
    int n = sb_mesh_element_width(mesh);
    double *volumes = (double *)calloc((size_t)mesh->node_count, sizeof(double));
    for (int e = 0; e < mesh->element_count && volumes; e++)
        for (int a = 0; a < n; a++)
            volumes[mesh->elements[e * n + a]] += (double)sb_mesh_element_volume(mesh, e) / n;
    return volumes;
}

/* Barycentric coordinates xi[3] of a point in the straight tet, and the least of all four. */
static double locate(const sb_mesh *mesh, const int *corners, sb_vec3 point, sb_real xi[3])
{
    sb_vec3 o = mesh->nodes[corners[0]];
    sb_mat3 edges = sb_m3_columns(sb_v3_sub(mesh->nodes[corners[1]], o), sb_v3_sub(mesh->nodes[corners[2]], o),
                                  sb_v3_sub(mesh->nodes[corners[3]], o));
    sb_vec3 b = sb_m3_apply(sb_m3_inverse(edges), sb_v3_sub(point, o));
    xi[0] = b.x, xi[1] = b.y, xi[2] = b.z;
    return fmin(fmin((double)b.x, (double)b.y), fmin((double)b.z, 1 - (double)(b.x + b.y + b.z)));
}

/* 1 when a tet reaches the height of a point. */
static int at_height(const sb_mesh *mesh, const int *corners, double z, double rim)
{
    int above = 0, below = 0;
    for (int a = 0; a < 4; a++) {
        above |= (double)mesh->nodes[corners[a]].z > z - rim;
        below |= (double)mesh->nodes[corners[a]].z < z + rim;
    }
    return above && below;
}

/* Values u of a mesh of straight tets at points: from the tet that a point is in, or that it is least outside of. */
static void sample_tets(const sb_mesh *mesh, const sb_vec3 *u, const sb_vec3 *points, int count, sb_vec3 *out)
{
    int n = sb_mesh_element_width(mesh);
    for (int i = 0; i < count; i++) {
        double best = -HUGE_VAL;
        sb_real xi[3] = {0, 0, 0}, shape[SB_MAX_ELEMENT_NODES];
        int element = 0;
        for (int t = 0; t < mesh->element_count && best < -1e-9; t++) {
            sb_real at[3];
            double least;
            if (!at_height(mesh, mesh->elements + t * n, (double)points[i].z, 1e-9))
                continue;
            least = locate(mesh, mesh->elements + t * n, points[i], at);
            if (least > best) {
                best = least;
                element = t;
                memcpy(xi, at, sizeof xi);
            }
        }
        sb_element_shape(mesh->element_type, xi, shape, NULL);
        out[i] = sb_v3(0, 0, 0);
        for (int a = 0; a < n; a++)
            out[i] = sb_v3_madd(out[i], shape[a], u[mesh->elements[element * n + a]]);
    }
}

/* ---- the two kinds of discretisation --------------------------------------------------------------------------- */

/* Solves with conforming elements; the displacements at the reference's nodes go to u[]. */
static int run_mesh(const settings *s, const experiment *e, sb_element_type type, int across, sb_vec3 *u, int *nodes)
{
    sb_mesh mesh;
    sb_body *body = NULL;
    sb_error error;
    int status;
    memset(&mesh, 0, sizeof mesh);
    if (sb_mesh_cylinder(type, 2, (sb_real)radius, (sb_real)e->length, across, layers(e, across), NULL, &mesh,
                         &error) != SB_OK)
        return complain("the mesh", &error);
    status = solve(s, e, &mesh, NULL, &body);
    *nodes = mesh.node_count;
    if (!status)
        sample_tets(&mesh, sb_body_displacements(body), e->reference.nodes, e->reference.node_count, u);
    sb_body_destroy(body);
    sb_mesh_free(&mesh);
    return status;
}

/* The same with a grid, whose planes hold the ends. */
static int run_grid(const settings *s, const experiment *e, const series *curve, int across, sb_vec3 *u, int *nodes)
{
    sb_grid_def def = sb_default_grid_def();
    sb_grid grid;
    sb_grid_rows rows;
    sb_body *body = NULL;
    sb_error error;
    double length = e->length;
    int status;
    memset(&grid, 0, sizeof grid);
    memset(&rows, 0, sizeof rows);
    def.method = curve->method;
    def.level = curve->level;
    def.outer.distance = cylinder_distance;
    def.outer.max_slope = 1;
    def.outer.user = &length;
    def.void_stiffness = (sb_real)s->void_stiffness;
    def.low = sb_v3((sb_real)-radius, (sb_real)-radius, 0);
    def.high = sb_v3((sb_real)radius, (sb_real)radius, (sb_real)length);
    def.counts[0] = def.counts[1] = across;
    def.counts[2] = layers(e, across);
    if (sb_grid_create(&def, &grid, &error) != SB_OK)
        return complain("the grid", &error);
    status = solve(s, e, &grid.body_mesh, &grid, &body);
    *nodes = grid.mesh.node_count;
    if (!status && sb_grid_map_points(&grid, e->reference.nodes, e->reference.node_count, NULL, &rows, &error) != SB_OK)
        status = complain("the points of the reference", &error);
    if (!status)
        sb_mapping_apply(&rows.rows, sb_body_displacements(body), u);
    sb_grid_rows_free(&rows);
    sb_body_destroy(body);
    sb_grid_free(&grid);
    return status;
}

/* ---- references ------------------------------------------------------------------------------------------------ */

/* Solves the reference: hex20, finer than all that is compared with it. */
static int make_reference(const settings *s, experiment *e)
{
    sb_body *body = NULL;
    sb_error error;
    int across = s->quick ? 6 : e->stretch ? 16 : 10, status;
    int along = e->stretch ? layers(e, across) : layers(e, across) / 2;
    if (sb_mesh_cylinder(SB_HEX20, 2, (sb_real)radius, (sb_real)e->length, across, along, NULL, &e->reference,
                         &error) != SB_OK)
        return complain("the reference", &error);
    status = solve(s, e, &e->reference, NULL, &body);
    e->solution = (sb_vec3 *)malloc((size_t)e->reference.node_count * sizeof(sb_vec3));
    if (e->solution && !status)
        memcpy(e->solution, sb_body_displacements(body), (size_t)e->reference.node_count * sizeof(sb_vec3));
    sb_body_destroy(body);
    return e->solution ? status : EXIT_SOLVE;
}

/* Reads the reference of a case folder instead; its length says which experiment it is. */
static int read_reference(const char *folder, experiment *e)
{
    char path[512], line[256];
    sb_error error;
    sb_vec3 low, high;
    FILE *file;
    int lines = 0, good = 1;
    snprintf(path, sizeof path, "%s/mesh.vtk", folder);
    if (sb_mesh_load(&e->reference, path, NULL, &error) != SB_OK) {
        complain(path, &error);
        return EXIT_USAGE;
    }
    sb_mesh_bounds(&e->reference, &low, &high);
    e->solution = (sb_vec3 *)calloc((size_t)e->reference.node_count, sizeof(sb_vec3));
    snprintf(path, sizeof path, "%s/solution.txt", folder);
    file = fopen(path, "r");
    while (file && e->solution && good && fgets(line, sizeof line, file)) {
        int node;
        double u[3];
        if (line[0] == '#')
            continue;
        good = sscanf(line, "%d %lf %lf %lf", &node, &u[0], &u[1], &u[2]) == 4 && node >= 0 &&
               node < e->reference.node_count;
        if (good)
            e->solution[node] = sb_v3((sb_real)u[0], (sb_real)u[1], (sb_real)u[2]);
        lines += good;
    }
    if (file)
        fclose(file);
    if (lines != e->reference.node_count) {
        fprintf(stderr, "cylinder_study: %s: not a line `node ux uy uz` for each node of the mesh\n", path);
        return EXIT_USAGE;
    }
    if (fabs((double)high.x - radius) > 1e-3 * radius ||
        fabs((double)(high.z - low.z) - e->length) > 1e-3 * e->length) {
        e->name = NULL; /* another experiment's */
        return 0;
    }
    return 0;
}

/* ---- the study ------------------------------------------------------------------------------------------------- */

static void show_progress(const experiment *e, const char *name, int across, int done, int total)
{
    char words[64];
    snprintf(words, sizeof words, "%s: %s, %d across", e->name, name, across);
    progress_show((double)done / total, words);
}

/* Solves all sizes of all curves of an experiment; prints a row of the table for each. */
static int run_experiment(const settings *s, const experiment *e, series *curves, FILE *csv)
{
    static const int sizes[2][MOST_SIZES] = {{2, 4, 6, 8, 10}, {4, 8, 12, 16, 20}};
    double *volumes = node_volumes(&e->reference);
    sb_vec3 *u = (sb_vec3 *)malloc((size_t)e->reference.node_count * sizeof(sb_vec3));
    int count = s->quick ? 2 : MOST_SIZES, done = 0, total = SERIES * count, status = volumes && u ? 0 : EXIT_SOLVE;
    for (int c = 0; c < SERIES; c++)
        for (int k = 0; k < count && !status; k++, done++) {
            series *curve = curves + c;
            int across = sizes[e->stretch][k], nodes = 0;
            double started = seconds_now();
            if (k >= curve->most || (curve->element != SB_NO_ELEMENT && across < 4))
                continue;
            show_progress(e, curve->name, across, done, total);
            status = curve->element != SB_NO_ELEMENT ? run_mesh(s, e, curve->element, across, u, &nodes)
                                                     : run_grid(s, e, curve, across, u, &nodes);
            if (status)
                break;
            curve->nodes[curve->count] = nodes;
            curve->errors[curve->count] = relative_error(e, u, volumes);
            progress_end();
            printf("%-8s %-18s %7d %9d %9.3f %% %9.2f s\n", e->name, curve->name, across, nodes,
                   100 * curve->errors[curve->count], seconds_now() - started);
            fflush(stdout);
            fprintf(csv, "%s,%s,%d,%d,%.6g\n", e->name, curve->name, across, nodes, curve->errors[curve->count]);
            curve->count++;
        }
    progress_end();
    free(u);
    free(volumes);
    return status;
}

static void set_series(series *curve, const char *name, sb_element_type element, sb_grid_method method, int level,
                       int most)
{
    memset(curve, 0, sizeof *curve);
    curve->name = name;
    curve->element = element;
    curve->method = method;
    curve->level = level;
    curve->most = most;
}

static void set_all_series(series curves[SERIES])
{
    set_series(curves, "tet4", SB_TET4, SB_GRID_SPARSE, 0, MOST_SIZES);
    set_series(curves + 1, "tet10", SB_TET10, SB_GRID_SPARSE, 0, 3);
    set_series(curves + 2, "sparse grid", SB_NO_ELEMENT, SB_GRID_SPARSE, 0, MOST_SIZES);
    set_series(curves + 3, "finite cell 1", SB_NO_ELEMENT, SB_GRID_FINITE_CELL, 1, 4);
    set_series(curves + 4, "finite cell 2", SB_NO_ELEMENT, SB_GRID_FINITE_CELL, 2, 3);
    set_series(curves + 5, "weighted cell 1", SB_NO_ELEMENT, SB_GRID_WEIGHTED_CELL, 1, MOST_SIZES);
    set_series(curves + 6, "weighted cell 2", SB_NO_ELEMENT, SB_GRID_WEIGHTED_CELL, 2, MOST_SIZES);
    set_series(curves + 7, "weighted cell 4", SB_NO_ELEMENT, SB_GRID_WEIGHTED_CELL, 4, MOST_SIZES);
}

static void add_panel(plot *p, const experiment *e, const series curves[SERIES])
{
    plot_panel *panel =
        plot_add_panel(p, e->stretch ? "5 cm, stretched to three times its length" : "60 cm, bent by 30 Pa", "nodes",
                       "relative L2 error of the displacement");
    panel->log_x = panel->log_y = 1;
    for (int c = 0; c < SERIES; c++) {
        plot_curve *curve = plot_add_curve(panel, curves[c].name, curves[c].nodes, curves[c].errors, curves[c].count);
        curve->markers = 1;
        curve->dashed = curves[c].element != SB_NO_ELEMENT;
    }
}

static int run_all(const settings *s, const char *folder, FILE *csv, plot *p, series curves[2][SERIES])
{
    experiment both[2];
    int status = 0, studied = 0;
    memset(both, 0, sizeof both);
    both[0].name = "bend";
    both[0].length = 0.6;
    both[1].name = "stretch";
    both[1].length = 0.05;
    both[1].stretch = 1;
    printf("%-8s %-18s %7s %9s %11s %11s\n", "study", "method", "across", "nodes", "error", "time");
    fprintf(csv, "study,method,across,nodes,error\n");
    for (int k = 0; k < 2 && !status; k++) {
        if (!folder)
            progress_show(0, both[k].stretch ? "stretch: reference" : "bend: reference");
        status = folder ? read_reference(folder, both + k) : make_reference(s, both + k);
        set_all_series(curves[k]);
        if (!status && both[k].name) {
            status = run_experiment(s, both + k, curves[k], csv);
            add_panel(p, both + k, curves[k]);
            studied++;
        }
        sb_mesh_free(&both[k].reference);
        free(both[k].solution);
    }
    if (!status && !studied) {
        fprintf(stderr, "cylinder_study: %s: no cylinder of radius 5 cm along z and length 60 cm or 5 cm\n", folder);
        status = EXIT_USAGE;
    }
    return status;
}

static int program(int argc, char **argv)
{
    settings s = {"cylinder_study", 0, 0, 1e-4, 1};
    option list[] = {
        {"-o", "NAME", OPTION_TEXT, NULL, NULL, &s.out, 0, 0, "writes NAME.svg and NAME.csv"},
        {"--quick", NULL, OPTION_FLAG, &s.quick, NULL, NULL, 0, 0,
         "two sizes of each and a coarser reference: seconds"},
        {"--steps", "N", OPTION_INTEGER, &s.steps, NULL, NULL, 1, 1000, "load steps to begin with"},
        {"--void", "A", OPTION_NUMBER, NULL, &s.void_stiffness, NULL, 0, 0.5, "share of the stiffness outside"},
        {"--help", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, "this text"},
    };
    enum { OPTIONS = sizeof list / sizeof list[0] };
    const char *folder = NULL;
    char path[512];
    static series curves[2][SERIES];
    plot p;
    sb_output csv;
    int status, written;
    if (!options_parse("cylinder_study", list, OPTIONS, &folder, 1, argc, argv))
        return EXIT_USAGE;
    if (s.help) {
        printf("cylinder_study [OPTIONS] [CASE]: errors of immersed grids on a bent and a stretched cylinder. CASE: "
               "folder "
               "with mesh.vtk and solution.txt to compare with, otherwise a fine mesh is solved\n\n");
        options_print(list, OPTIONS);
        printf("\nThe table: cells (or elements) across the diameter, nodes, the L2 norm of the displacement's error "
               "relative to\n"
               "that of the reference, and the wall time of one solution. \"weighted cell 4\": level 4, cut cells are "
               "halved\n"
               "four times to find what lies inside.\n");
        return 0;
    }
    snprintf(path, sizeof path, "%s.csv", s.out);
    if (sb_output_open(&csv, path, NULL) != SB_OK) {
        fprintf(stderr, "cylinder_study: %s: cannot be written\n", path);
        return EXIT_USAGE;
    }
    plot_begin(&p, "Cylinders on immersed grids");
    status = run_all(&s, folder, csv.file, &p, curves);
    written = sb_output_close(&csv, NULL) == SB_OK;
    if (!status && written) {
        snprintf(path, sizeof path, "%s.svg", s.out);
        written = plot_save_svg(&p, path);
    }
    if (!written) {
        fprintf(stderr, "cylinder_study: %s: cannot be written\n", path);
        status = status ? status : EXIT_USAGE;
    }
    if (!status)
        printf("%s.csv and %s.svg written\n", s.out, s.out);
    return status;
}

int main(int argc, char **argv) { return finish("cylinder_study", program(argc, argv), EXIT_USAGE); }
