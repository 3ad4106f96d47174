/* surface_to_sim: from closed surfaces to a simulation, and back to the screen.
 *
 *     surface_to_sim SURFACE [INNER...] [OPTIONS]      surface_to_sim --help lists the options
 *
 * SURFACE may also be a label image, a segmentation: its labels together are the body, each but the first an inner
 * part. Fills a surface with tets (isosurface stuffing) or lays it into a grid of bricks (immersed boundary), holds one
 * end, lets gravity act, and writes the surfaces as the body carries them along. INNER surfaces lie inside: regions of
 * their own, three times as stiff. The last line tells what the volume mesh is like. Exit status: 0, 2 wrong usage, a
 * file that cannot be read or written, or a surface that encloses nothing, 3 no memory or a step failed. */
#include "system.h"

#if defined(_OPENMP)
#define SB_USE_OPENMP
#endif
#define SB_IMPLEMENTATION
#include "softbody.h"

#include "options.h"

enum { EXIT_USAGE = 2, EXIT_SOLVE = 3, MAX_SURFACES = 16 };
#define REAL(x) ((sb_real)(x)) /* everything here computes in double, the body in sb_real */

typedef enum method {
    STUFF = 0,
    SPARSE = SB_GRID_SPARSE,
    FINITE_CELL = SB_GRID_FINITE_CELL,
    WEIGHTED_CELL = SB_GRID_WEIGHTED_CELL
} method;

typedef struct settings {
    const char *surfaces[MAX_SURFACES]; /* the outer one first */
    int surface_count;
    const char *out, *mesh, *hold, *label;
    int stuff, sparse, finite_cell, weighted_cell;
    int cells, coarsen, level, tet10, repair, steps, help;
    double scale, young, poisson, density, contrast, dt;
} settings;

/* What lasts from the files to the pictures. Zeros: nothing yet. */
typedef struct work {
    settings *set;
    sb_image image; /* when the first surface is one: all its labels are surface 0, label i is surface i */
    int labels[MAX_SURFACES], label_count;
    char names[MAX_SURFACES][32];
    method how;
    sb_mesh surfaces[MAX_SURFACES];
    sb_surface *trees[MAX_SURFACES];
    sb_mesh skin; /* all surfaces, a region each */
    sb_mesh tets; /* of the stuffing */
    sb_grid grid;
    const sb_mesh *volume; /* what is simulated: the tets or the grid's cells */
    sb_real min_dihedral, max_dihedral, distance;
    double volume_share[MAX_SURFACES], surface_share[MAX_SURFACES]; /* of the stuffing, -1: unknown */
    double seconds;                                                 /* that the volume took */
    sb_body *body;
    sb_embedding *embedding;
} work;

/* ---- messages -------------------------------------------------------------------------------------------------- */

static int complain(const sb_error *error)
{
    progress_end();
    if (error->file[0] && error->line > 0)
        fprintf(stderr, "surface_to_sim: %s:%d: %s\n", error->file, error->line, error->message);
    else if (error->file[0])
        fprintf(stderr, "surface_to_sim: %s: %s\n", error->file, error->message);
    else
        fprintf(stderr, "surface_to_sim: %s\n", error->message);
    return error->result == SB_ERROR_MEMORY ? EXIT_SOLVE : EXIT_USAGE;
}

static int complain_about(const char *path, const sb_error *error)
{
    progress_end();
    fprintf(stderr, "surface_to_sim: %s: %s\n", path, error->message);
    return error->result == SB_ERROR_MEMORY ? EXIT_SOLVE : EXIT_USAGE;
}

static int complain_memory(void)
{
    progress_end();
    fputs("surface_to_sim: not enough memory\n", stderr);
    return EXIT_SOLVE;
}

static int show_meshing(void *user, double share)
{
    (void)user;
    progress_show(share, "volume");
    return 0;
}

static sb_jobs threads(void)
{
#if defined(SB_USE_OPENMP)
    return sb_jobs_openmp();
#else
    sb_jobs none = {NULL, NULL};
    return none;
#endif
}

/* ---- surfaces -------------------------------------------------------------------------------------------------- */

static int repair_surface(const char *path, sb_mesh *mesh)
{
    sb_surface_repair_def def = sb_default_surface_repair();
    sb_surface_repair_report done;
    sb_error error;
    int removed;
    def.max_hole_edges = 64;
    if (sb_surface_repair(mesh, &def, &done, &error) != SB_OK)
        return complain_about(path, &error);
    removed = done.removed_degenerate + done.removed_duplicates;
    if (done.merged_nodes || removed || done.flipped_edges || done.turned_faces || done.filled_holes)
        fprintf(stderr,
                "surface_to_sim: %s: warning: repaired: %d nodes merged, %d faces removed, %d edges flipped, "
                "%d faces turned, %d holes filled\n",
                path, done.merged_nodes, removed, done.flipped_edges, done.turned_faces, done.filled_holes);
    return 0;
}

/* How often a surface has one of the findings. */
static int count_of(const sb_surface_report *report, int finding)
{
    int i = 0;
    while (finding >> i > 1)
        i++;
    return report->place[i].count;
}

/* What is wrong with a surface ends the program. After a repair what is left is a warning, and so are small folds (up
 * to 1 % of the triangles cross): the inside is then where the winding number says so. */
static int check_surface(const settings *set, const char *path, sb_mesh *mesh)
{
    sb_surface_report report;
    sb_error error;
    int status = set->repair ? repair_surface(path, mesh) : 0;
    int fatal = set->repair ? 0 : SB_SURFACE_NOT_SOLID & ~SB_SURFACE_SELF_CROSSING;
    sb_result result;
    if (status)
        return status;
    result = sb_surface_require(mesh, fatal, NULL, &report, &error);
    if (result == SB_OK && fatal && count_of(&report, SB_SURFACE_SELF_CROSSING) > mesh->element_count / 100)
        result = sb_surface_require(mesh, SB_SURFACE_SELF_CROSSING, NULL, NULL, &error);
    if (result != SB_OK) {
        complain_about(path, &error);
        fputs("surface_to_sim: --repair mends what can be mended\n", stderr);
        return EXIT_USAGE;
    }
    for (int finding = 1; finding <= report.findings; finding *= 2)
        if (report.findings & finding)
            fprintf(stderr, "surface_to_sim: %s: warning: %d %s\n", path, count_of(&report, finding),
                    sb_surface_check_string(finding));
    return 0;
}

/* The triangles of a file. */
static int load_surface(const settings *set, const char *path, sb_mesh *mesh)
{
    sb_load_options options = sb_default_load_options();
    sb_mesh loaded;
    sb_error error;
    sb_result result;
    memset(&loaded, 0, sizeof loaded);
    options.scale = REAL(set->scale);
    if (sb_mesh_load(&loaded, path, &options, &error) != SB_OK)
        return complain(&error);
    result = sb_surface_triangulate(&loaded, NULL, mesh, &error);
    sb_mesh_free(&loaded);
    return result == SB_OK ? check_surface(set, path, mesh) : complain_about(path, &error);
}

/* ---- label images ---------------------------------------------------------------------------------------------- */

/* The labels of --label, or all of the image. */
static int choose_labels(work *w)
{
    const char *at = w->set->label;
    int label = 0;
    if (!at) {
        while (w->label_count < MAX_SURFACES && sb_image_next_label(&w->image, label, &label))
            w->labels[w->label_count++] = label;
        if (w->label_count > 0)
            return 0;
        options_complain("surface_to_sim", w->set->surfaces[0], "has no label above 0");
        return EXIT_USAGE;
    }
    for (; w->label_count < MAX_SURFACES; at++) {
        char *end;
        long number = strtol(at, &end, 10);
        if (end == at || number < -2147483647L || number > 2147483647L || (*end && *end != ','))
            break;
        w->labels[w->label_count++] = (int)number;
        at = end;
        if (!*at)
            return 0;
    }
    options_complain("surface_to_sim", "--label", "needs whole numbers, as 1,2,3");
    return EXIT_USAGE;
}

static int label_surface(const char *path, const sb_image *image, const int *labels, int count, sb_mesh *mesh)
{
    sb_label_def def = sb_default_label_def();
    sb_error error;
    def.image = image;
    def.labels = labels;
    def.label_count = count;
    return sb_image_surface(&def, mesh, NULL, &error) == SB_OK ? 0 : complain_about(path, &error);
}

static int load_image(const settings *set, const char *path, sb_image *image)
{
    sb_load_options options = sb_default_load_options();
    sb_error error;
    options.scale = REAL(set->scale);
    return sb_image_load(image, path, &options, &error) == SB_OK ? 0 : complain(&error);
}

/* Puts the labels but the first before the inner surfaces of the command line. */
static int open_image(work *w)
{
    settings *set = w->set;
    int status, inner;
    if (!sb_image_is_file(set->surfaces[0]))
        return !set->label || options_complain("surface_to_sim", "--label", "is for label images") ? 0 : EXIT_USAGE;
    status = load_image(set, set->surfaces[0], &w->image);
    if (!status)
        status = choose_labels(w);
    if (status)
        return status;
    inner = w->label_count - 1;
    if (set->surface_count + inner > MAX_SURFACES)
        return options_complain("surface_to_sim", set->surfaces[0], "has too many labels: choose some with --label")
                   ? 0
                   : EXIT_USAGE;
    for (int i = set->surface_count - 1; i > 0; i--)
        set->surfaces[i + inner] = set->surfaces[i];
    for (int i = 1; i <= inner; i++) {
        snprintf(w->names[i], sizeof w->names[i], "label %d", w->labels[i]);
        set->surfaces[i] = w->names[i];
    }
    set->surface_count += inner;
    return 0;
}

/* A surface of whatever kind. */
static int make_surface(work *w, int i)
{
    const char *path = w->set->surfaces[i];
    sb_image image;
    int status;
    if (i < w->label_count)
        return label_surface(path, &w->image, w->labels + i, i ? 1 : w->label_count, &w->surfaces[i]);
    if (!sb_image_is_file(path))
        return load_surface(w->set, path, &w->surfaces[i]);
    memset(&image, 0, sizeof image);
    status = load_image(w->set, path, &image);
    if (!status)
        status = label_surface(path, &image, NULL, 0, &w->surfaces[i]);
    sb_image_free(&image);
    return status;
}

static int load_surfaces(work *w)
{
    for (int i = 0; i < w->set->surface_count; i++) {
        const char *path = w->set->surfaces[i];
        sb_error error;
        int status = make_surface(w, i);
        if (status)
            return status;
        if (sb_surface_create(&w->surfaces[i], NULL, &w->trees[i], &error) != SB_OK)
            return complain_about(path, &error);
    }
    return 0;
}

/* All surfaces as one mesh, a region each: what is drawn. */
static int join_surfaces(work *w)
{
    for (int i = 0; i < w->set->surface_count; i++) {
        sb_mesh part = w->surfaces[i];
        sb_error error;
        int *regions = (int *)malloc((size_t)part.element_count * sizeof *regions);
        sb_result result;
        if (!regions)
            return complain_memory();
        for (int e = 0; e < part.element_count; e++)
            regions[e] = i;
        part.regions = regions;
        result = i == 0 ? sb_mesh_copy(&part, NULL, &w->skin, &error) : sb_mesh_append(&w->skin, &part, &error);
        free(regions);
        if (result != SB_OK)
            return complain_about(w->set->surfaces[i], &error);
    }
    return 0;
}

/* ---- the volume ------------------------------------------------------------------------------------------------ */

/* Edge (m) of a cell: `cells` of them along the longest side of the outer surface. */
static double cell_size(const work *w)
{
    sb_vec3 low, high, size;
    sb_surface_bounds(w->trees[0], &low, &high);
    size = sb_v3_sub(high, low);
    return fmax((double)size.x, fmax((double)size.y, (double)size.z)) / w->set->cells;
}

/* A surface that lies in a plane encloses nothing, however fine the cells. */
static int check_extent(const work *w)
{
    sb_vec3 low, high;
    sb_surface_bounds(w->trees[0], &low, &high);
    if (low.x < high.x && low.y < high.y && low.z < high.z)
        return 0;
    fprintf(stderr, "surface_to_sim: %s: is flat: it encloses nothing\n", w->set->surfaces[0]);
    return EXIT_USAGE;
}

/* Says so when an inner surface reaches out of the outer one by more than a tenth of a cell: what is out there belongs
 * to no part of the body. */
static void warn_outside(const work *w)
{
    double rim = 0.1 * cell_size(w);
    for (int i = 1; i < w->set->surface_count; i++) {
        const sb_mesh *inner = &w->surfaces[i];
        int outside = 0;
        for (int k = 0; k < inner->node_count; k++)
            outside += (double)sb_surface_signed_distance_winding(w->trees[0], inner->nodes[k], NULL) > rim;
        if (outside > 0)
            fprintf(stderr,
                    "surface_to_sim: %s: warning: %d of its %d vertices lie outside %s, which is to enclose "
                    "it\n",
                    w->set->surfaces[i], outside, inner->node_count, w->set->surfaces[0]);
    }
}

/* Most volumes that cannot be made are thinner than a cell; the message may name the cell that would do. */
static int complain_volume(const work *w, const sb_error *error)
{
    static const char words[] = "try cells of ";
    int status = complain_about(w->set->surfaces[0], error);
    const char *at = strstr(error->message, words);
    double needed = at ? strtod(at + sizeof words - 1, NULL) : 0;
    if (needed > 0)
        fprintf(stderr, "surface_to_sim: that is --cells %.0f\n", ceil(cell_size(w) / needed * w->set->cells));
    else if (error->result == SB_ERROR_MESH)
        fprintf(stderr, "surface_to_sim: it may be thinner than a cell: try more than --cells %d\n", w->set->cells);
    return status;
}

/* What a mesh keeps of each surface. */
static void print_shares(const work *w)
{
    for (int i = 0; i < w->set->surface_count && w->how == STUFF; i++) {
        char of_volume[48] = "";
        if (w->volume_share[i] >= 0)
            snprintf(of_volume, sizeof of_volume, "%.1f %% of the volume, ", 100 * w->volume_share[i]);
        printf("%-14s %s%.1f %% of the surface of %s\n", "kept", of_volume, 100 * fmax(w->surface_share[i], 0),
               w->set->surfaces[i]);
    }
}

static int stuff(work *w, const sb_shape *shapes)
{
    sb_stuff_def def = sb_default_stuff_def();
    sb_stuff_report report;
    sb_error error;
    def.shapes = shapes;
    def.shape_count = w->set->surface_count;
    def.cell = REAL(cell_size(w));
    def.levels = w->set->coarsen;
    def.type = w->set->tet10 ? SB_TET10 : SB_TET4;
    def.progress = show_meshing;
    def.jobs = threads();
    if (sb_mesh_stuff(&def, &w->tets, &report, &error) != SB_OK)
        return complain_volume(w, &error);
    w->volume = &w->tets;
    w->min_dihedral = report.min_dihedral;
    w->max_dihedral = report.max_dihedral;
    w->distance = report.distance;
    for (int i = 0; i < w->set->surface_count; i++) {
        w->volume_share[i] = (double)report.volume_share[i];
        w->surface_share[i] = (double)report.surface_share[i];
    }
    return 0;
}

/* Largest distance (m) of the surface's vertices from the grid's cells: 0 when these hold all of it. */
static int measure_grid(work *w)
{
    sb_grid_rows rows;
    sb_error error;
    memset(&rows, 0, sizeof rows);
    if (sb_grid_map_points(&w->grid, w->surfaces[0].nodes, w->surfaces[0].node_count, NULL, &rows, &error) != SB_OK)
        return complain_about(w->set->surfaces[0], &error);
    w->distance = rows.farthest;
    w->min_dihedral = w->max_dihedral = 90;
    sb_grid_rows_free(&rows);
    return 0;
}

static int lay_grid(work *w, const sb_shape *shapes)
{
    sb_grid_def def = sb_default_grid_def();
    sb_error error;
    def.method = (sb_grid_method)w->how;
    def.level = w->how == SPARSE ? 0 : w->set->level;
    def.outer = shapes[0];
    def.inner = shapes + 1;
    def.inner_count = w->set->surface_count - 1;
    def.cell_size = REAL(cell_size(w));
    def.progress = show_meshing;
    def.jobs = threads();
    if (sb_grid_create(&def, &w->grid, &error) != SB_OK)
        return complain_volume(w, &error);
    w->volume = &w->grid.mesh;
    return measure_grid(w);
}

static int make_volume(work *w)
{
    sb_shape shapes[MAX_SURFACES];
    double start;
    int status;
    if (check_extent(w))
        return EXIT_USAGE;
    warn_outside(w);
    start = seconds_now();
    memset(shapes, 0, sizeof shapes);
    for (int i = 0; i < w->set->surface_count; i++) {
        shapes[i].surface = w->trees[i];
        shapes[i].region = i;
    }
    status = w->how == STUFF ? stuff(w, shapes) : lay_grid(w, shapes);
    w->seconds = seconds_now() - start;
    progress_end();
    return status;
}

/* ---- the simulation -------------------------------------------------------------------------------------------- */

/* Holds the nodes in the outer tenth of the volume at one end, or as deep as a cell if that is deeper: what a surface
 * leaves of the outermost cells of a grid can be too little to hold on to. "-z" is the lowest end. */
static sb_result hold_end(work *w)
{
    int axis = w->set->hold[1] - 'x', high_end = w->set->hold[0] == '+';
    sb_vec3 low, high;
    double from, to, depth, limit;
    sb_mesh_bounds(w->volume, &low, &high);
    from = axis == 0 ? (double)low.x : axis == 1 ? (double)low.y : (double)low.z;
    to = axis == 0 ? (double)high.x : axis == 1 ? (double)high.y : (double)high.z;
    depth = fmax(0.1 * (to - from), fmin(1.001 * cell_size(w), 0.5 * (to - from)));
    limit = high_end ? to - depth : from + depth;
    for (int i = 0; i < w->volume->node_count; i++) {
        const sb_vec3 *x = &w->volume->nodes[i];
        double place = axis == 0 ? (double)x->x : axis == 1 ? (double)x->y : (double)x->z;
        if (high_end ? place >= limit : place <= limit) {
            sb_result result = sb_body_fix_nodes(w->body, &i, 1, SB_XYZ);
            if (result != SB_OK)
                return result;
        }
    }
    return SB_OK;
}

/* Every inner surface must have left elements. */
static int check_regions(const work *w, const sb_mesh *mesh)
{
    for (int i = 1; i < w->set->surface_count; i++) {
        int e = 0;
        while (e < mesh->element_count && (!mesh->regions || mesh->regions[e] != i))
            e++;
        if (e == mesh->element_count) {
            fprintf(stderr,
                    "surface_to_sim: %s: encloses no part of the body: it lies outside, or is smaller than a cell\n",
                    w->set->surfaces[i]);
            return EXIT_USAGE;
        }
    }
    return 0;
}

static int make_body(work *w)
{
    const settings *set = w->set;
    sb_region_material inner[MAX_SURFACES];
    sb_body_def def = sb_default_body_def();
    sb_embedding_def embedding = sb_default_embedding_def();
    sb_error error;
    def.mesh = w->how == STUFF ? w->volume : &w->grid.body_mesh;
    def.domain = w->how == STUFF ? NULL : &w->grid.domain;
    if (check_regions(w, def.mesh))
        return EXIT_USAGE;
    def.material = sb_material_corotated(REAL(set->young), REAL(set->poisson), REAL(set->density));
    for (int i = 1; i < set->surface_count; i++) {
        inner[i - 1].region = i;
        inner[i - 1].material =
            sb_material_corotated(REAL(set->young * set->contrast), REAL(set->poisson), REAL(set->density));
    }
    def.region_materials = set->surface_count > 1 ? inner : NULL;
    def.region_material_count = set->surface_count - 1;
    def.gravity = sb_v3(0, 0, REAL(-9.81));
    def.damping_stiffness = REAL(0.02);
    def.jobs = threads();
    if (sb_body_create(&def, &w->body, &error) != SB_OK)
        return complain_about("the body", &error);
    if (hold_end(w) != SB_OK)
        return complain_memory();
    embedding.mesh = w->volume;
    embedding.surface = &w->skin;
    embedding.jobs = threads();
    if (sb_embedding_create(&embedding, &w->embedding, &error) != SB_OK)
        return complain_about("the embedding", &error);
    return 0;
}

static int simulate(work *w)
{
    char words[64];
    for (int step = 1; step <= w->set->steps; step++) {
        sb_step_info info;
        if (sb_body_step(w->body, REAL(w->set->dt), &info) != SB_OK) {
            progress_end();
            fprintf(stderr, "surface_to_sim: step %d: %s\n", step, info.error.message);
            return EXIT_SOLVE;
        }
        snprintf(words, sizeof words, "step %d of %d, %d iterations", step, w->set->steps, info.pcg_iterations);
        progress_show((double)step / w->set->steps, words);
    }
    progress_end();
    return 0;
}

/* ---- what is written ------------------------------------------------------------------------------------------- */

/* values[rows] = sum of weights times node values. */
static void map_scalars(const sb_mapping *rows, const sb_real *nodes, sb_real *values)
{
    for (int i = 0; i < rows->row_count; i++) {
        values[i] = 0;
        for (int k = rows->row_start[i]; k < rows->row_start[i + 1]; k++)
            values[i] += rows->weights[k] * nodes[rows->nodes[k]];
    }
}

/* The surfaces where the body has carried them, with displacement, normals and stress. */
static int write_surface(work *w, const sb_real *stress)
{
    int n = w->skin.node_count, status = 0;
    sb_vec3 *numbers = (sb_vec3 *)malloc(3 * (size_t)n * sizeof *numbers), *points = numbers;
    sb_real *skin_stress = (sb_real *)malloc((size_t)n * sizeof *skin_stress);
    sb_embedding_rows rows;
    sb_error error;
    memset(&rows, 0, sizeof rows);
    if (!numbers || !skin_stress || sb_embedding_mapping(w->embedding, NULL, &rows, &error) != SB_OK) {
        status = complain_memory();
    } else {
        sb_mesh deformed = w->skin;
        sb_field fields[3] = {{"displacement", SB_FIELD_NODES, 3, NULL},
                              {"normal", SB_FIELD_NODES, 3, NULL},
                              {"von_mises", SB_FIELD_NODES, 1, NULL}};
        sb_jobs jobs = threads();
        sb_embedding_update(w->embedding, sb_body_positions(w->body), points, points + n, &jobs);
        for (int i = 0; i < n; i++)
            points[2 * n + i] = sb_v3_sub(points[i], w->skin.nodes[i]);
        map_scalars(&rows.mapping, stress, skin_stress);
        fields[0].values = &points[2 * n].x;
        fields[1].values = &points[n].x;
        fields[2].values = skin_stress;
        deformed.nodes = points;
        if (sb_mesh_save_vtk(w->set->out, &deformed, fields, 3, &error) != SB_OK)
            status = complain(&error);
    }
    sb_embedding_rows_free(&rows);
    free(numbers);
    free(skin_stress);
    return status;
}

/* The volume at rest, with the displacement. */
static int write_volume(work *w, const sb_real *stress)
{
    sb_field fields[2] = {{"displacement", SB_FIELD_NODES, 3, NULL}, {"von_mises", SB_FIELD_NODES, 1, NULL}};
    sb_error error;
    if (!w->set->mesh)
        return 0;
    fields[0].values = &sb_body_displacements(w->body)->x;
    fields[1].values = stress;
    return sb_mesh_save_vtk(w->set->mesh, w->volume, fields, 2, &error) == SB_OK ? 0 : complain(&error);
}

static int write_files(work *w)
{
    sb_real *stress = (sb_real *)malloc((size_t)w->volume->node_count * sizeof *stress);
    int status;
    if (!stress)
        return complain_memory();
    sb_body_nodal_von_mises(w->body, stress);
    status = write_volume(w, stress);
    if (!status)
        status = write_surface(w, stress);
    free(stress);
    return status;
}

/* Gravity can be more than the body bears: elements turned inside out tell of folds that the pictures show. */
static void warn_inverted(const work *w)
{
    const sb_vec3 *x = sb_body_positions(w->body);
    int width = sb_mesh_element_width(w->volume), inverted = 0;
    if (w->how != STUFF)
        return; /* of a brick only what lies inside the surface matters */
    for (int e = 0; e < w->volume->element_count; e++) {
        const int *c = w->volume->elements + e * width;
        sb_vec3 a = sb_v3_sub(x[c[1]], x[c[0]]), b = sb_v3_sub(x[c[2]], x[c[0]]);
        inverted += (double)sb_v3_dot(sb_v3_cross(a, b), sb_v3_sub(x[c[3]], x[c[0]])) <= 0;
    }
    if (inverted > 0)
        fprintf(stderr,
                "surface_to_sim: warning: %d tets are turned inside out at the end: the body is too soft or too "
                "heavy for how it is held (--young, --density, --hold)\n",
                inverted);
}

static void print_summary(const work *w)
{
    static const char *const names[] = {"tets", "sparse grid", "finite cells", "weighted cells"};
    sb_embedding_report held = sb_embedding_get_report(w->embedding);
    const sb_vec3 *u = sb_body_displacements(w->body);
    sb_real largest = 0;
    for (int i = 0; i < w->volume->node_count; i++)
        largest = fmax(largest, sb_v3_norm(u[i]));
    printf("%-14s %d nodes, %d elements, cells of %.3g mm\n", names[w->how], w->volume->node_count,
           w->volume->element_count, 1e3 * cell_size(w));
    print_shares(w);
    printf("%-14s %d vertices: %d inside, %d outside by up to %.3g mm\n", "embedded", held.point_count, held.inside,
           held.point_count - held.inside, 1e3 * (double)held.max_distance);
    printf("%-14s %d steps of %.3g ms, largest displacement %.3g mm\n", "simulation", w->set->steps, 1e3 * w->set->dt,
           1e3 * (double)largest);
    printf("%-14s %s%s%s\n", "written", w->set->out, w->set->mesh ? ", " : "", w->set->mesh ? w->set->mesh : "");
    printf("%s=%d min_dihedral=%.2f max_dihedral=%.2f distance=%.4g seconds=%.3f\n", w->how == STUFF ? "tets" : "cells",
           w->volume->element_count, (double)w->min_dihedral, (double)w->max_dihedral, (double)w->distance, w->seconds);
}

/* ---- the program ----------------------------------------------------------------------------------------------- */

static void release(work *w)
{
    sb_embedding_destroy(w->embedding);
    sb_body_destroy(w->body);
    sb_grid_free(&w->grid);
    sb_mesh_free(&w->tets);
    sb_mesh_free(&w->skin);
    sb_image_free(&w->image);
    for (int i = 0; i < MAX_SURFACES; i++) {
        sb_surface_destroy(w->trees[i]);
        sb_mesh_free(&w->surfaces[i]);
    }
}

static int run(settings *set)
{
    static int (*const stages[])(work *) = {open_image, load_surfaces, join_surfaces, make_volume,
                                            make_body,  simulate,      write_files};
    work w;
    int status = 0;
    memset(&w, 0, sizeof w);
    w.set = set;
    w.how = set->sparse ? SPARSE : set->finite_cell ? FINITE_CELL : set->weighted_cell ? WEIGHTED_CELL : STUFF;
    for (size_t i = 0; i < sizeof stages / sizeof stages[0] && !status; i++)
        status = stages[i](&w);
    if (!status) {
        warn_inverted(&w);
        print_summary(&w);
    }
    release(&w);
    return status;
}

/* 1 when the arguments go together. */
static int check_settings(settings *s)
{
    const char *h = s->hold;
    while (s->surface_count < MAX_SURFACES && s->surfaces[s->surface_count])
        s->surface_count++;
    if (s->surface_count == 0)
        return options_complain("surface_to_sim", "SURFACE", "is missing");
    if (s->stuff + s->sparse + s->finite_cell + s->weighted_cell > 1)
        return options_complain("surface_to_sim", "--stuff, --wc, --fc, --sparse:", "only one of them");
    if ((s->tet10 || s->coarsen > 0) && s->sparse + s->finite_cell + s->weighted_cell > 0)
        return options_complain("surface_to_sim", s->tet10 ? "--tet10" : "--coarsen", "is for tets, not for grids");
    if (strlen(h) != 2 || !strchr("+-", h[0]) || !strchr("xyz", h[1]))
        return options_complain("surface_to_sim", "--hold", "needs -x, +x, -y, +y, -z or +z");
    for (int i = 0; i < s->surface_count; i++)
        if (is_same_file(s->surfaces[i], s->out) || (s->mesh && is_same_file(s->surfaces[i], s->mesh)))
            return options_complain("surface_to_sim", s->surfaces[i], "would be overwritten");
    if (s->mesh && strcmp(s->mesh, s->out) == 0)
        return options_complain("surface_to_sim", s->mesh, "is to be both the surface and the volume");
    return 1;
}

static int program(int argc, char **argv)
{
    static settings s;
    s.out = "surface_out.vtk";
    s.hold = "+z"; /* it hangs; held below, soft organs topple over */
    s.cells = 24, s.level = 3, s.steps = 60;
    s.scale = 1, s.young = 5e3, s.poisson = 0.45, s.density = 1060, s.contrast = 3, s.dt = 1 / 60.0;
    const option options[] = {
        {"--stuff", NULL, OPTION_FLAG, &s.stuff, NULL, NULL, 0, 0, "fill it with tets (the default)"},
        {"--wc", NULL, OPTION_FLAG, &s.weighted_cell, NULL, NULL, 0, 0, "grid of weighted cells instead"},
        {"--fc", NULL, OPTION_FLAG, &s.finite_cell, NULL, NULL, 0, 0, "grid of finite cells: exact, slower"},
        {"--sparse", NULL, OPTION_FLAG, &s.sparse, NULL, NULL, 0, 0, "grid of full cells: crude"},
        {"--cells", "N", OPTION_INTEGER, &s.cells, NULL, NULL, 2, 1000, "cells along the longest side"},
        {"--coarsen", "K", OPTION_INTEGER, &s.coarsen, NULL, NULL, 0, 8, "tets: cells inside up to 2^K times as large"},
        {"--level", "L", OPTION_INTEGER, &s.level, NULL, NULL, 0, SB_GRID_MAX_LEVEL,
         "--wc, --fc: how often cut cells are halved"},
        {"--tet10", NULL, OPTION_FLAG, &s.tet10, NULL, NULL, 0, 0, "quadratic tets"},
        {"--label", "N,...", OPTION_TEXT, NULL, NULL, &s.label, 0, 0,
         "of a label image: what is the body, and parts of it; all"},
        {"--repair", NULL, OPTION_FLAG, &s.repair, NULL, NULL, 0, 0,
         "weld, orient and patch bad surfaces instead of refusing them"},
        {"--scale", "X", OPTION_NUMBER, NULL, &s.scale, NULL, 1e-9, 1e9,
         "multiplies the files' lengths; 0.001 for millimetres"},
        {"--young", "PA", OPTION_NUMBER, NULL, &s.young, NULL, 1, 1e12, "Young's modulus (Pa)"},
        {"--poisson", "NU", OPTION_NUMBER, NULL, &s.poisson, NULL, 0, 0.499, "Poisson's ratio"},
        {"--density", "RHO", OPTION_NUMBER, NULL, &s.density, NULL, 1e-3, 1e6, "density (kg/m^3)"},
        {"--contrast", "X", OPTION_NUMBER, NULL, &s.contrast, NULL, 1e-6, 1e6, "inner parts are so much stiffer"},
        {"--hold", "END", OPTION_TEXT, NULL, NULL, &s.hold, 0, 0, "the end that is held: -x, +x, -y, +y, -z or +z"},
        {"--steps", "N", OPTION_INTEGER, &s.steps, NULL, NULL, 0, 1e6, "time steps under gravity (along -z)"},
        {"--dt", "S", OPTION_NUMBER, NULL, &s.dt, NULL, 1e-6, 10, "length of a step (s)"},
        {"-o", "FILE", OPTION_TEXT, NULL, NULL, &s.out, 0, 0, "the deformed surfaces (VTK)"},
        {"--mesh", "FILE", OPTION_TEXT, NULL, NULL, &s.mesh, 0, 0, "the volume mesh at rest, with displacements (VTK)"},
        {"--help", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, "this text"},
        {"-h", NULL, OPTION_FLAG, &s.help, NULL, NULL, 0, 0, NULL},
    };
    const int count = (int)(sizeof options / sizeof options[0]);
    if (!options_parse("surface_to_sim", options, count, s.surfaces, MAX_SURFACES, argc, argv))
        return EXIT_USAGE;
    if (s.help) {
        printf("usage: surface_to_sim SURFACE [INNER...] [OPTIONS]\n\n"
               "Fills a closed surface (OBJ, STL, PLY, OFF or VTK, in metres) with tets or lays it into a grid, holds "
               "one\n"
               "end, lets gravity act, and writes the surface as the body carries it along. INNER surfaces lie inside "
               "the\n"
               "first one and are stiffer parts of the body. A label image (NIfTI, NRRD, MetaImage, VTK) in place of "
               "SURFACE is a\n"
               "body of all its labels; each but the first is a stiffer part.\n\n");
        options_print(options, count);
        printf("\nThe last line is about the volume mesh: elements, dihedral angles (degrees), the largest distance "
               "(m) of\n"
               "its boundary from SURFACE (grids: of SURFACE from the cells), and the seconds it took to make.\n");
        return 0;
    }
    return check_settings(&s) ? run(&s) : EXIT_USAGE;
}

int main(int argc, char **argv) { return finish("surface_to_sim", program(argc, argv), EXIT_USAGE); }
