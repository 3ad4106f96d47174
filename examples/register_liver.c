/* register_liver: brings an organ model onto what was seen of the organ, and says where its inside is then.
 *
 *     register_liver MODEL TARGET [OPTIONS]      register_liver --help lists the options
 *
 * MODEL is a volume mesh, or a closed surface, which is then filled with tets; TARGET a surface or a point cloud, whole
 * or a part, in any pose. It is aligned rigidly first, from all directions, and then deformed. All numbers in files are
 * in metres (or --scale), nodes count from 0, # begins a comment:
 *     --landmarks FILE     x y z  X Y Z    a point of the model, and where it is seen; three or more, or with icp
 *                                          any, guide the rigid start, too
 *     --curves FILE        c 0  x y z      the next corner of line c (0, 1, ...) of the model: a ridge, a vessel,
 *                          c 1  X Y Z      and of what is seen of it; infer only
 *     --fix FILE           n               a node of the model that moves with the organ as a whole only,
 *                          x y z           or the node nearest to a point,
 *                          a b c d         or all nodes with a x + b y + c z < d
 *     --targets FILE       x y z           points of the model to carry along; --targets-out: where they are then
 *     --displacement FILE  n ux uy uz      is written: of every node, rigid part included
 *     --picture FILE.png                   is written: the organ where it is now, and what was seen of it
 * The last line is iterations=N steps_per_second=S seconds=T distance_mm=D stop=REASON: of the deformation, but for T,
 * which is all from the files to the result, and D, the mean distance of the target's points from the registered
 * surface. Which way a target's surface faces is known from --camera, or found: both ways are tried. What the rigid
 * start warns of is said by name. Exit status: 0, 2 wrong usage or a file that cannot be read or written, 3 no
 * registration was found, or two that the target does not tell apart (--any takes the likelier one; better: --camera,
 * --seen-from or landmarks), 4 one was written that is not to be trusted: cut off by its time, of another size, or
 * still far from the target (--force: 0 for these). A small distance does not tell how far off what was not seen is:
 * --method infer does, after stop=REASON: expected_mm=E expected_worst_mm=W prior=KIND, mean and worst over the model's
 * nodes, and as `expected` (m) of each node in the VTK file; with --gas gas_pa=P before these, the pressure (Pa) that
 * an organ of --young is under. It is the method for views of a part; from a whole surface pbsm is closer. Above
 * --limit, or with less than 15 % of the organ seen, the status is 4, and above the limit the point of the model is
 * named that is worth touching: as a landmark it would lower the error to expect most. */
#include "system.h"

#if defined(_OPENMP)
#define SB_USE_OPENMP
#endif
#define SB_IMPLEMENTATION
#define REG_IMPLEMENTATION
#include "register.h"

#include "options.h"
#include "picture.h"
#include "registration.h"
#include "rows.h"

enum { EXIT_USAGE = 2, EXIT_FAILED = 3, EXIT_DOUBTFUL = 4 };
#define REAL(x) ((sb_real)(x)) /* files and everything here are in double, the body in sb_real */

typedef struct settings {
    const char *method, *surface, *landmarks, *curves, *fix, *targets, *targets_out, *displacement, *out, *picture,
        *camera, *seen_from, *gas;
    int linear, partial, aligned, any, noisy, plain, force, cells, steps, help;
    double scale, young, poisson, seconds, limit;
} settings;

/* What lasts from the files to the results. Zeros: nothing yet. */
typedef struct work {
    const settings *set;
    method how;
    sb_mesh model, surface, target;
    reg_cloud cloud;
    int has_surface, has_target, has_camera, has_seen_from, has_gas;
    sb_vec3 camera;         /* m */
    sb_vec3 seen_from, gas; /* of any length */
    sb_vec3 *landmarks, *landmark_targets;
    int landmark_count;
    reg_curve *curves;
    sb_vec3 *curve_points; /* of all of them */
    int curve_count;
    int *fixed, fixed_count;
    sb_vec3 *targets;
    int target_count;
    outcome out;
} work;

/* ---- messages -------------------------------------------------------------------------------------------------- */

static int complain(const char *path, const char *message)
{
    progress_end();
    fprintf(stderr, "register_liver: %s: %s\n", path, message);
    return EXIT_USAGE;
}

static int complain_line(const char *path, int line, const char *message)
{
    progress_end();
    fprintf(stderr, "register_liver: %s:%d: %s\n", path, line, message);
    return EXIT_USAGE;
}

static int complain_error(const char *path, const sb_error *error)
{
    const char *file = error->file[0] ? error->file : path;
    return error->line > 0 ? complain_line(file, error->line, error->message) : complain(file, error->message);
}

static int complain_memory(void)
{
    progress_end();
    fputs("register_liver: not enough memory\n", stderr);
    return EXIT_FAILED;
}

/* ---- text files of numbers ------------------------------------------------------------------------------------- */

static int read_rows(const char *path, unsigned columns, const char *form, rows *table)
{
    return rows_read("register_liver", path, columns, form, table);
}

static sb_vec3 row_point(const settings *set, const row *item, int first)
{
    const double *v = item->values + first;
    return sb_v3(REAL(v[0] * set->scale), REAL(v[1] * set->scale), REAL(v[2] * set->scale));
}

/* ---- what is read ---------------------------------------------------------------------------------------------- */

static int show_filling(void *user, double share)
{
    (void)user;
    progress_show(share, "filling the surface with tets");
    return 0;
}

/* A closed surface as model: tets of about 2000 nodes for a liver. */
static int fill_surface(work *w, const char *path)
{
    sb_stuff_def def = sb_default_stuff_def();
    sb_surface *tree = NULL;
    sb_shape shape;
    sb_vec3 low, high, size;
    sb_error error;
    sb_result result;
    memset(&shape, 0, sizeof shape);
    w->surface = w->model;
    w->has_surface = 1;
    memset(&w->model, 0, sizeof w->model);
    if (sb_surface_require(&w->surface, SB_SURFACE_OPEN_EDGES | SB_SURFACE_INSIDE_OUT, NULL, NULL, &error) != SB_OK ||
        sb_surface_create(&w->surface, NULL, &tree, &error) != SB_OK)
        return complain_error(path, &error);
    sb_surface_bounds(tree, &low, &high);
    size = sb_v3_sub(high, low);
    shape.surface = tree;
    def.shapes = &shape;
    def.shape_count = 1;
    def.cell = sb_max(size.x, sb_max(size.y, size.z)) / REAL(w->set->cells);
    def.progress = show_filling;
    result = sb_mesh_stuff(&def, &w->model, NULL, &error);
    sb_surface_destroy(tree);
    progress_end();
    return result == SB_OK ? 0 : complain_error(path, &error);
}

static int load_mesh(const settings *set, const char *path, sb_mesh *mesh)
{
    sb_load_options options = sb_default_load_options();
    sb_error error;
    options.scale = REAL(set->scale);
    return sb_mesh_load(mesh, path, &options, &error) == SB_OK ? 0 : complain_error(path, &error);
}

static int load_model(work *w, const char *path)
{
    sb_error error;
    int status = load_mesh(w->set, path, &w->model);
    if (status)
        return status;
    if (sb_element_dimension(w->model.element_type) == 2)
        return fill_surface(w, path);
    if (w->set->surface) {
        status = load_mesh(w->set, w->set->surface, &w->surface);
        if (!status && sb_element_dimension(w->surface.element_type) != 2)
            status = complain(w->set->surface, "is no surface");
        w->has_surface = 1;
    }
    if (!status && w->has_surface &&
        sb_surface_require(&w->surface, SB_SURFACE_INSIDE_OUT, NULL, NULL, &error) != SB_OK)
        status = complain_error(w->set->surface, &error);
    return status;
}

enum { MOST_POINTS = 50000 };

/* Of a dense scan the means of small cubes do as well, in a twentieth of the time. */
static int thin_target(work *w, const char *path)
{
    sb_vec3 low = w->cloud.points[0], high = low;
    sb_real size;
    sb_error error;
    int count = w->cloud.count;
    if (count <= MOST_POINTS)
        return 0;
    for (int i = 1; i < count; i++) {
        sb_vec3 x = w->cloud.points[i];
        low = sb_v3(sb_min(low.x, x.x), sb_min(low.y, x.y), sb_min(low.z, x.z));
        high = sb_v3(sb_max(high.x, x.x), sb_max(high.y, x.y), sb_max(high.z, x.z));
    }
    size = sb_v3_norm(sb_v3_sub(high, low)) / 200; /* a round organ has some 40,000 of such */
    if (!(size > 0))
        return 0;
    if (reg_cloud_thin(&w->cloud, size, &w->cloud, &error) != SB_OK)
        return complain_error(path, &error);
    printf("%s: %d points, thinned to %d by cubes of %.3g mm\n", path, count, w->cloud.count, 1e3 * (double)size);
    return 0;
}

/* X,Y,Z of an option, in the files' unit; nothing where it was not given. */
static int parse_place(const work *w, const char *name, const char *text, sb_vec3 *place, int *given)
{
    row item;
    if (!text)
        return 0;
    if (rows_parse(text, &item) != 1 || item.count != 3) {
        fprintf(stderr, "register_liver: %s %s: not X,Y,Z\n", name, text);
        return EXIT_USAGE;
    }
    *place = row_point(w->set, &item, 0);
    *given = 1;
    return 0;
}

static int parse_directions(work *w)
{
    int status = parse_place(w, "--camera", w->set->camera, &w->camera, &w->has_camera);
    if (!status)
        status = parse_place(w, "--seen-from", w->set->seen_from, &w->seen_from, &w->has_seen_from);
    if (!status && w->has_seen_from && !(sb_v3_norm(w->seen_from) > 0))
        status = complain("--seen-from", "0,0,0 is no direction");
    if (!status)
        status = parse_place(w, "--gas", w->set->gas, &w->gas, &w->has_gas);
    if (!status && w->has_gas && !(sb_v3_norm(w->gas) > 0))
        status = complain("--gas", "0,0,0 is no direction");
    return status;
}

/* Share of the normals that point away from the camera. */
static double share_facing_away(const work *w, const sb_vec3 *points, const sb_vec3 *normals, int count)
{
    int away = 0, known = 0;
    for (int i = 0; i < count; i++) {
        sb_real towards = sb_v3_dot(normals[i], sb_v3_sub(w->camera, points[i]));
        known += towards < 0 || towards > 0;
        away += towards < 0;
    }
    return known ? (double)away / known : 0.5;
}

static void say_turned(const char *path)
{
    progress_end();
    fprintf(stderr, "register_liver: %s: its normals point inwards: turned\n", path);
}

/* What a camera saw faces it: nearly all normals do, or nearly none do and they are turned, or they mean nothing. */
static int face_camera(work *w, const char *path)
{
    const double few = 0.1;
    reg_cloud seen;
    sb_error error;
    double away;
    if (!w->has_target && !w->cloud.normals)
        away = 0.5;
    else if (!w->has_target)
        away = share_facing_away(w, w->cloud.points, w->cloud.normals, w->cloud.count);
    else {
        if (reg_cloud_from_mesh(&seen, &w->target, NULL, &error) != SB_OK)
            return complain_error(path, &error);
        away = share_facing_away(w, seen.points, seen.normals, seen.count);
        reg_cloud_free(&seen);
    }
    if (away <= few)
        return 0;
    if (away < 1 - few) {
        if (w->has_target)
            return complain(path, "a part of its triangles faces the camera, a part looks away: a camera sees no back");
        if (w->cloud.normals)
            fprintf(stderr, "register_liver: %s: its normals point both ways: made anew\n", path);
        return reg_cloud_estimate_normals(&w->cloud, 12, &w->camera, NULL, &error) == SB_OK
                   ? 0
                   : complain_error(path, &error);
    }
    say_turned(path);
    target_turn(&w->target, &w->cloud);
    return 0;
}

/* Which way the target faces, where a camera tells; else the rigid start finds out. */
static int face_target(work *w, const char *path)
{
    int status = parse_directions(w);
    return status || !w->has_camera ? status : face_camera(w, path);
}

/* A surface when the file has one, else its points. */
static int load_target(work *w, const char *path)
{
    sb_load_options options = sb_default_load_options();
    sb_mesh loaded;
    sb_error error;
    memset(&loaded, 0, sizeof loaded);
    options.scale = REAL(w->set->scale);
    if (sb_mesh_load(&loaded, path, &options, &error) == SB_OK) {
        int surface = sb_element_dimension(loaded.element_type) == 2;
        sb_result result = surface ? sb_surface_triangulate(&loaded, NULL, &w->target, &error) : SB_OK;
        sb_mesh_free(&loaded);
        if (result != SB_OK)
            return complain_error(path, &error);
        if (!surface)
            return complain(path, "is a volume: the target is a surface or a cloud of points");
        w->has_target = 1;
        return 0;
    }
    if (reg_cloud_load(&w->cloud, path, REAL(w->set->scale), NULL, &error) != SB_OK)
        return complain_error(path, &error);
    if (thin_target(w, path))
        return EXIT_USAGE;
    return 0;
}

/* Standard deviations (m) of points along their principal axes, the largest first. */
static sb_vec3 principal_spread(const sb_vec3 *points, int count)
{
    sb_vec3 mean = sb_v3(0, 0, 0), squares;
    sb_mat3 sum = sb_m3_zero(), axes;
    for (int i = 0; i < count; i++)
        mean = sb_v3_madd(mean, 1 / (sb_real)(i + 1), sb_v3_sub(points[i], mean));
    for (int i = 0; i < count; i++) {
        sb_vec3 d = sb_v3_sub(points[i], mean);
        sum = sb_m3_add(sum, sb_m3_outer(d, d));
    }
    sb_m3_eigen(sum, &squares, &axes);
    squares = sb_v3_scale(1 / (sb_real)count, squares);
    return sb_v3(sb_sqrt(sb_max(squares.x, 0)), sb_sqrt(sb_max(squares.y, 0)), sb_sqrt(sb_max(squares.z, 0)));
}

/* Targets that cannot be what was seen of the organ, for which every method has some answer. */
static int check_target(const work *w, const char *path)
{
    const double flat = 1e-4;
    int partial = w->set->partial || w->has_target; /* a surface tells by itself */
    sb_vec3 seen = w->has_target ? principal_spread(w->target.nodes, w->target.node_count)
                                 : principal_spread(w->cloud.points, w->cloud.count);
    sb_vec3 organ = principal_spread(w->model.nodes, w->model.node_count);
    double share = (double)(seen.x / organ.x);
    char message[160];
    if (!((double)seen.y > flat * (double)seen.x))
        return complain(path, "all points lie in one place or line: they do not show an organ");
    if (!partial && !((double)seen.z > flat * (double)seen.x))
        return complain(path, "all points lie in one plane: they can only show a part of an organ (--partial)");
    if (share < 5 && share > (partial ? 0.02 : 0.2))
        return 0;
    snprintf(message, sizeof message, "is %.3g times as large as the model: are both in one unit (--scale)%s?", share,
             partial || share > 1 ? "" : ", is it a part (--partial)");
    return complain(path, message);
}

static int load_landmarks(work *w)
{
    rows table;
    int status = read_rows(w->set->landmarks, 1u << 6, "not `x y z  X Y Z`", &table);
    if (!status) {
        w->landmarks = (sb_vec3 *)malloc((size_t)table.count * sizeof *w->landmarks);
        w->landmark_targets = (sb_vec3 *)malloc((size_t)table.count * sizeof *w->landmark_targets);
        if (!w->landmarks || !w->landmark_targets)
            status = complain_memory();
    }
    for (int i = 0; !status && i < table.count; i++) {
        w->landmarks[i] = row_point(w->set, table.items + i, 0);
        w->landmark_targets[i] = row_point(w->set, table.items + i, 3);
        w->landmark_count = i + 1;
    }
    free(table.items);
    return status;
}

/* Rows of one curve, of the model (side 0) or of what is seen (1), in order: *points moves behind them. */
static int take_corners(const work *w, const rows *table, int curve, int side, sb_vec3 **points)
{
    int count = 0;
    for (int i = 0; i < table->count; i++) {
        const row *item = table->items + i;
        if ((int)item->values[0] == curve && (int)item->values[1] == side)
            (*points)[count++] = row_point(w->set, item, 2);
    }
    *points += count;
    return count;
}

/* Curves are known to half a hundredth of the organ's size. */
static void take_curves(work *w, const rows *table)
{
    sb_vec3 *points = w->curve_points, low, high;
    sb_mesh_bounds(&w->model, &low, &high);
    for (int c = 0; c < w->curve_count; c++) {
        reg_curve *curve = w->curves + c;
        curve->model = points;
        curve->model_count = take_corners(w, table, c, 0, &points);
        curve->seen = points;
        curve->seen_count = take_corners(w, table, c, 1, &points);
        curve->sd = (sb_real)0.005 * sb_v3_norm(sb_v3_sub(high, low));
    }
}

static int load_curves(work *w)
{
    enum { MOST_CURVES = 1000 };
    rows table;
    int status = read_rows(w->set->curves, 1u << 5, "not `c 0  x y z` or `c 1  X Y Z`", &table);
    for (int i = 0; !status && i < table.count; i++) {
        double c = table.items[i].values[0], side = table.items[i].values[1];
        if (!(c >= 0 && c < (int)MOST_CURVES && c == floor(c)) || (side != 0 && side != 1))
            status =
                complain_line(w->set->curves, table.items[i].line, "not `c 0  x y z` or `c 1  X Y Z`, c from 0 on");
        else if ((int)c >= w->curve_count)
            w->curve_count = (int)c + 1;
    }
    if (!status) {
        w->curves = (reg_curve *)calloc((size_t)w->curve_count, sizeof *w->curves);
        w->curve_points = (sb_vec3 *)malloc((size_t)table.count * sizeof *w->curve_points);
        if (!w->curves || !w->curve_points)
            status = complain_memory();
        else
            take_curves(w, &table);
    }
    free(table.items);
    return status;
}

static int nearest_node(const sb_mesh *mesh, sb_vec3 at)
{
    int best = 0;
    sb_real least = SB_REAL_MAX;
    for (int i = 0; i < mesh->node_count; i++) {
        sb_vec3 d = sb_v3_sub(mesh->nodes[i], at);
        if (sb_v3_dot(d, d) < least) {
            least = sb_v3_dot(d, d);
            best = i;
        }
    }
    return best;
}

/* Marks the nodes that a line of the file names. */
static int mark_fixed(const work *w, const row *item, unsigned char *held)
{
    const double *v = item->values;
    if (item->count == 1) {
        if (!(v[0] >= 0 && v[0] < w->model.node_count && v[0] == floor(v[0])))
            return complain_line(w->set->fix, item->line, "no node of the model has that number");
        held[(int)v[0]] = 1;
    } else if (item->count == 3) {
        held[nearest_node(&w->model, row_point(w->set, item, 0))] = 1;
    } else {
        for (int i = 0; i < w->model.node_count; i++) {
            sb_vec3 x = w->model.nodes[i];
            if (v[0] * (double)x.x + v[1] * (double)x.y + v[2] * (double)x.z < v[3] * w->set->scale)
                held[i] = 1;
        }
    }
    return 0;
}

static int load_fixed(work *w)
{
    rows table;
    unsigned char *held = (unsigned char *)calloc((size_t)w->model.node_count, 1);
    int status = read_rows(w->set->fix, 1u << 1 | 1u << 3 | 1u << 4,
                           "not a node `n`, a point `x y z` or a half space "
                           "`a b c d`",
                           &table);
    w->fixed = (int *)malloc((size_t)w->model.node_count * sizeof *w->fixed);
    if (!status && (!held || !w->fixed))
        status = complain_memory();
    for (int i = 0; !status && i < table.count; i++)
        status = mark_fixed(w, table.items + i, held);
    for (int i = 0; !status && i < w->model.node_count; i++)
        if (held[i])
            w->fixed[w->fixed_count++] = i;
    free(table.items);
    free(held);
    return status;
}

static int load_targets(work *w)
{
    rows table;
    int status = read_rows(w->set->targets, 1u << 3, "not `x y z`", &table);
    if (!status) {
        w->targets = (sb_vec3 *)malloc((size_t)table.count * sizeof *w->targets);
        if (!w->targets)
            status = complain_memory();
    }
    for (int i = 0; !status && i < table.count; i++) {
        w->targets[i] = row_point(w->set, table.items + i, 0);
        w->target_count = i + 1;
    }
    free(table.items);
    return status;
}

static int load_all(work *w, const char *const files[2])
{
    int status = load_model(w, files[0]);
    if (!status)
        status = load_target(w, files[1]);
    if (!status)
        status = check_target(w, files[1]);
    if (!status)
        status = face_target(w, files[1]);
    if (!status && w->set->landmarks)
        status = load_landmarks(w);
    if (!status && w->set->curves)
        status = load_curves(w);
    if (!status && w->set->fix)
        status = load_fixed(w);
    if (!status && w->set->targets)
        status = load_targets(w);
    return status;
}

/* ---- what is written ------------------------------------------------------------------------------------------- */

/* In the unit of the files. */
static int write_points(const settings *set, const char *path, const sb_vec3 *points, int count, int numbered)
{
    sb_output out;
    sb_error error;
    if (sb_output_open(&out, path, &error) != SB_OK)
        return complain_error(path, &error);
    fputs(numbered ? "# node ux uy uz\n" : "# x y z\n", out.file);
    for (int i = 0; i < count; i++) {
        if (numbered)
            fprintf(out.file, "%d ", i);
        fprintf(out.file, "%.9g %.9g %.9g\n", (double)points[i].x / set->scale, (double)points[i].y / set->scale,
                (double)points[i].z / set->scale);
    }
    return sb_output_close(&out, &error) == SB_OK ? 0 : complain_error(path, &error);
}

static int write_targets(const work *w)
{
    sb_vec3 *moved = (sb_vec3 *)malloc((size_t)(w->target_count + 1) * sizeof *moved);
    sb_error error;
    int status;
    if (!moved)
        return complain_memory();
    status = outcome_carry(&w->out, w->targets, w->target_count, moved, &error) != SB_OK
                 ? complain_error(w->set->targets, &error)
                 : write_points(w->set, w->set->targets_out, moved, w->target_count, 0);
    free(moved);
    return status;
}

/* The model where it is now, with its displacement and, where it was inferred, the error to expect of each node (m). */
static int write_model(const work *w, sb_vec3 *moved, const sb_vec3 *displacement)
{
    sb_mesh mesh = w->model;
    sb_field fields[2] = {{"displacement", SB_FIELD_NODES, 3, NULL}, {"expected", SB_FIELD_NODES, 1, NULL}};
    sb_real *expected = (sb_real *)malloc((size_t)mesh.node_count * sizeof *expected);
    sb_error error;
    sb_result result;
    if (!expected)
        return complain_memory();
    mesh.nodes = moved;
    fields[0].values = &displacement[0].x;
    fields[1].values = expected;
    if (w->out.infer)
        (void)reg_infer_expected(w->out.infer, expected);
    result = sb_mesh_save_vtk(w->set->out, &mesh, fields, w->out.infer ? 2 : 1, &error);
    free(expected);
    return result == SB_OK ? 0 : complain_error(w->set->out, &error);
}

/* ---- the picture ----------------------------------------------------------------------------------------------- */

enum { PICTURE_POINTS = 3000, PICTURE_FEW = 600 }; /* of the target are drawn at most; that hide the organ little */

/* What is drawn: the organ's skin in the target's frame, points of the target, and a number of each (m). */
typedef struct view {
    sb_mesh skin; /* nodes are the view's own, the rest the boundary's */
    sb_real *skin_values;
    sb_vec3 *points;
    double *point_values;
    int point_count;
    double most;
} view;

static void view_free(view *v)
{
    free(v->skin.nodes);
    free(v->skin_values);
    free(v->points);
    free(v->point_values);
}

/* The skin from places of all nodes, and values [nodes] or NULL for none. */
static int view_skin(view *v, const sb_boundary *boundary, const sb_vec3 *moved, const sb_real *values)
{
    size_t count = (size_t)boundary->surface.node_count;
    v->skin = boundary->surface;
    v->skin.nodes = (sb_vec3 *)malloc(count * sizeof *v->skin.nodes);
    v->skin_values = (sb_real *)calloc(count, sizeof *v->skin_values);
    if (!v->skin.nodes || !v->skin_values)
        return 0;
    for (size_t i = 0; i < count; i++) {
        size_t node = boundary->nodes ? (size_t)boundary->nodes[i] : i;
        v->skin.nodes[i] = moved[node];
        v->skin_values[i] = values ? values[node] : 0;
    }
    return 1;
}

/* Points of the target, evenly picked, and how far from the skin they are. */
static sb_result view_points(view *v, const work *w, sb_error *error)
{
    const sb_vec3 *points = w->has_target ? w->target.nodes : w->cloud.points;
    int count = w->has_target ? w->target.node_count : w->cloud.count,
        stride = 1 + count / (w->out.infer ? PICTURE_FEW : PICTURE_POINTS);
    sb_surface *tree = NULL;
    sb_result result;
    v->points = (sb_vec3 *)malloc(PICTURE_POINTS * sizeof *v->points);
    v->point_values = (double *)malloc(PICTURE_POINTS * sizeof *v->point_values);
    if (!v->points || !v->point_values)
        return task_fail(error, SB_ERROR_MEMORY, "not enough memory for the picture");
    result = sb_surface_create(&v->skin, NULL, &tree, error);
    for (int i = 0; result == SB_OK && i < count; i += stride) {
        sb_surface_hit hit;
        if (sb_surface_closest_from(tree, points[i], SB_REAL_MAX, -1, &hit)) {
            v->points[v->point_count] = points[i];
            v->point_values[v->point_count++] = (double)hit.distance;
        }
    }
    sb_surface_destroy(tree);
    return result;
}

/* Where to stand to see most of the target: over the middle of what was seen of the organ. Degrees. */
static void view_direction(const view *v, double *azimuth, double *elevation)
{
    const double degree = 3.14159265358979323846 / 180;
    sb_vec3 low, high, middle = sb_v3(0, 0, 0), out;
    double size, aside;
    sb_mesh_bounds(&v->skin, &low, &high);
    for (int i = 0; i < v->point_count; i++)
        middle = sb_v3_madd(middle, REAL(1.0 / v->point_count), v->points[i]);
    out = sb_v3_sub(middle, sb_v3_scale(REAL(0.5), sb_v3_add(low, high)));
    size = (double)sb_v3_norm(sb_v3_sub(high, low));
    *azimuth = 30;
    *elevation = 25;
    if ((double)sb_v3_norm(out) < 0.05 * size) /* seen from all sides */
        return;
    aside = hypot((double)out.x, (double)out.y);
    *azimuth = atan2((double)out.x, -(double)out.y) / degree;
    *elevation = fmax(-80, fmin(80, atan2((double)out.z, aside) / degree));
}

static void draw_view(const view *v, const work *w, picture *p)
{
    sb_vec3 low, high, half;
    double azimuth, elevation, most = 0;
    char title[160];
    int of_skin = w->out.infer != NULL;
    for (int i = 0; i < v->skin.node_count; i++)
        most = fmax(most, (double)v->skin_values[i]);
    for (int i = 0; i < v->point_count && !of_skin; i++)
        most = fmax(most, v->point_values[i]);
    most = most > 0 ? most : 1e-3;
    sb_mesh_bounds(&v->skin, &low, &high);
    half = sb_v3(1, 1, 1);
    half = sb_v3_scale(REAL(of_skin ? 0.002 : 0.003) * sb_v3_norm(sb_v3_sub(high, low)), half);
    picture_add_surface(p, &v->skin, v->skin_values, 0, most);
    for (int i = 0; i < v->point_count; i++)
        picture_add_block(p, v->points[i], sb_quat_identity(), half,
                          of_skin ? picture_web(0x30363d) : picture_map(v->point_values[i] / most));
    view_direction(v, &azimuth, &elevation);
    picture_render(p, azimuth, elevation);
    picture_colour_bar(p, of_skin ? "error to expect" : "distance", "mm", 0, 1e3 * most, 1e3 * most);
    picture_length_bar(p);
    snprintf(title, sizeof title,
             of_skin ? "What error to expect where the organ is now" : "What was seen, over the organ");
    picture_text(p, 0.06 * p->width, 0.075 * p->height, 22, PICTURE_LEFT, picture_ink(), title);
    snprintf(title, sizeof title, "%s, %d points%s", w->set->method, v->point_count,
             of_skin ? " of what was seen" : " coloured by how far from it they are");
    picture_text(p, 0.06 * p->width, 0.115 * p->height, 14, PICTURE_LEFT, picture_ink(), title);
}

static int write_picture(const work *w, const sb_vec3 *moved)
{
    view v;
    picture p;
    sb_error error;
    sb_result result = SB_OK;
    int saved = PICTURE_NO_MEMORY;
    size_t n = (size_t)w->model.node_count;
    sb_real *expected = (sb_real *)calloc(n, sizeof *expected);
    memset(&v, 0, sizeof v);
    if (expected && w->out.infer)
        (void)reg_infer_expected(w->out.infer, expected);
    if (expected && view_skin(&v, &w->out.boundary, moved, expected))
        result = view_points(&v, w, &error);
    if (result == SB_OK && v.points) {
        picture_begin(&p, 1280, 960);
        draw_view(&v, w, &p);
        saved = picture_save_png(&p, w->set->picture);
        picture_end(&p);
    }
    view_free(&v);
    free(expected);
    if (result != SB_OK)
        return complain_error(w->set->picture, &error);
    return saved == PICTURE_OK        ? 0
           : saved == PICTURE_NO_FILE ? complain(w->set->picture, "could not be written")
                                      : complain_memory();
}

/* ---- all that is written --------------------------------------------------------------------------------------- */

static int write_all(const work *w)
{
    size_t n = (size_t)w->model.node_count;
    sb_vec3 *moved = (sb_vec3 *)malloc(2 * n * sizeof *moved);
    int status = 0;
    if (!moved)
        return complain_memory();
    outcome_nodes(&w->out, &w->model, moved);
    for (size_t i = 0; i < n; i++)
        moved[n + i] = sb_v3_sub(moved[i], w->model.nodes[i]);
    if (w->set->displacement)
        status = write_points(w->set, w->set->displacement, moved + n, (int)n, 1);
    if (!status && w->set->out)
        status = write_model(w, moved, moved + n);
    if (!status && w->set->picture)
        status = write_picture(w, moved);
    if (!status && w->set->targets)
        status = write_targets(w);
    free(moved);
    return status;
}

/* ---- the work -------------------------------------------------------------------------------------------------- */

static task make_task(const work *w)
{
    const settings *set = w->set;
    task given;
    memset(&given, 0, sizeof given);
    given.model = &w->model;
    given.surface = w->has_surface ? &w->surface : NULL;
    given.target = w->has_target ? &w->target : NULL;
    given.cloud = w->has_target ? NULL : &w->cloud;
    given.partial = set->partial;
    given.aligned = set->aligned;
    given.linear = set->linear;
    given.noisy = set->noisy;
    given.any = set->any;
    given.facing = !w->has_camera;
    given.camera = w->has_camera ? &w->camera : NULL;
    given.seen_from = w->has_seen_from ? &w->seen_from : NULL;
    given.gas = w->has_gas ? &w->gas : NULL;
    given.loads = !set->plain && !set->linear;
    given.fixed = w->fixed;
    given.fixed_count = w->fixed_count;
    given.landmarks = w->landmarks;
    given.landmark_targets = w->landmark_targets;
    given.landmark_count = w->landmark_count;
    given.curves = w->curves;
    given.curve_count = w->curve_count;
    given.young = set->young;
    given.poisson = set->poisson;
    given.steps = set->steps;
    given.max_seconds = set->seconds;
    given.progress = progress_show;
    return given;
}

/* Holes mean that a part is missing: half the organ's or a pixel. */
static int is_open(const sb_mesh *target)
{
    sb_surface *tree = NULL;
    int open = sb_surface_create(target, NULL, &tree, NULL) == SB_OK && !sb_surface_is_closed(tree);
    sb_surface_destroy(tree);
    return open;
}

static void tell_start(const work *w)
{
    const reg_rigid *start = &w->out.start;
    sb_vec3 low, high, centre;
    sb_mesh_bounds(&w->model, &low, &high);
    centre = sb_v3_scale(REAL(0.5), sb_v3_add(low, high));
    printf("%s, %d nodes, %d elements; rigid start: turned by %.2f degrees, moved by %.2f mm, %.3f s\n",
           method_names[w->how], w->model.node_count, w->model.element_count,
           57.29577951 * (double)reg_rigid_angle(start),
           1e3 * (double)sb_v3_norm(sb_v3_sub(reg_rigid_apply(start, centre), centre)), w->out.seconds_start);
}

/* What the rigid start and an inference warn of, by name. A turned target is reported by itself. */
static void tell_warnings(const work *w, const reg_quality *quality)
{
    static const struct {
        reg_warning warning;
        const char *words;
    } all[] = {
        {REG_WARN_AMBIGUOUS, "another pose explains the target about as well"},
        {REG_WARN_MIXED_NORMALS, "normals point towards the camera and away from it"},
        {REG_WARN_SCALE, "the target's size does not fit the model's"},
        {REG_WARN_VIEW_SMALL, "less than 15 % of the organ is seen, or too little for its shape"},
        {REG_WARN_MANY_OUTLIERS, "over 30 % of the target is nowhere near the model"},
        {REG_WARN_LOW_CONTRAST, "what is seen leaves a turn or a shift open"},
        {REG_WARN_FREE_SPACE, "a part of the model hides what the camera saw"},
        {REG_WARN_STRAIN, "the organ would be strained by more than 30 %"},
        {REG_WARN_VOLUME, "its volume would change by more than 10 %"},
        {REG_WARN_NOT_AT_REST, "the last round still moved it by more than the error to expect"},
    };
    const reg_icp_info *rigid = &w->out.rigid;
    unsigned warnings = rigid->warnings | quality->warnings;
    for (int i = 0; i < (int)(sizeof all / sizeof all[0]); i++)
        if (warnings & (unsigned)all[i].warning)
            fprintf(stderr, "register_liver: warning: %s: %s\n", reg_warning_string(all[i].warning), all[i].words);
    if (rigid->warnings & REG_WARN_SCALE)
        fprintf(stderr, "register_liver: times %.4g the target's lengths would fit\n", (double)rigid->scale_guess);
}

/* NULL, or why what was found is not to be trusted. A rigid start alone leaves what the organ was deformed by. */
static const char *doubt(const work *w, const reg_quality *quality, double median)
{
    const double far_off = 0.01; /* of the organ's size, beside noise */
    sb_vec3 low, high;
    sb_mesh_bounds(&w->model, &low, &high);
    if (strcmp(w->out.stop, "time_cap") == 0)
        return "cut off by its time (--seconds)";
    if (w->out.rigid.warnings & REG_WARN_SCALE)
        return "the target's size does not fit the model's (--scale)";
    if (strcmp(w->out.stop, "no_overlap") == 0 || strcmp(w->out.stop, "failed") == 0)
        return "the deformation ended early";
    if (w->out.infer && 1e3 * (double)quality->expected > w->set->limit)
        return "the error to expect is above the limit (--limit; landmarks or a larger view lower it)";
    if (w->out.infer && quality->seen < REAL(0.15))
        return "less than 15 % of the organ is seen";
    if (w->how != METHOD_ICP &&
        median > far_off * (double)sb_v3_norm(sb_v3_sub(high, low)) + 2 * (double)w->out.smooth.noise)
        return "half of the target is farther from the model than its noise explains";
    return NULL;
}

/* Where one more landmark would tell most, among nodes of the model's surface. */
static void advise(const work *w, const reg_quality *quality)
{
    enum { CANDIDATES = 100 };
    const double touch = 1e-3; /* m, how well an instrument's tip is known */
    sb_vec3 points[CANDIDATES];
    sb_boundary skin;
    sb_real after;
    int count = 0, step, best;
    if (sb_mesh_boundary(&w->model, 1, NULL, &skin, NULL) != SB_OK)
        return;
    step = 1 + (skin.surface.node_count - 1) / CANDIDATES;
    for (int i = 0; i < skin.surface.node_count; i += step)
        points[count++] = skin.surface.nodes[i];
    sb_boundary_free(&skin);
    if (reg_infer_best_landmark(w->out.infer, points, count, REAL(touch), &best, &after, NULL) == SB_OK &&
        after < quality->expected)
        fprintf(stderr,
                "register_liver: a landmark at %.4g %.4g %.4g of the model would lower it most: to some %.1f mm\n",
                (double)points[best].x / w->set->scale, (double)points[best].y / w->set->scale,
                (double)points[best].z / w->set->scale, 1e3 * (double)after);
}

static int run(work *w, double begun, const char *target)
{
    task given = make_task(w);
    sb_error error;
    double distance = 0, median = 0, seconds;
    const char *why;
    reg_quality quality;
    sb_result result;
    if (w->has_target && is_open(&w->target))
        given.partial = 1;
    result = task_run(&given, w->how, &w->out, &error);
    seconds = seconds_now() - begun;
    if (result == SB_OK)
        result = outcome_distance(&w->out, &given, &distance, &median, &error);
    progress_end();
    if (result != SB_OK) {
        complain_error("the registration", &error);
        return EXIT_FAILED;
    }
    if (w->out.is_turned)
        say_turned(target);
    tell_start(w);
    memset(&quality, 0, sizeof quality);
    if (w->out.infer)
        (void)reg_infer_get_quality(w->out.infer, &quality);
    tell_warnings(w, &quality);
    if (write_all(w))
        return EXIT_USAGE;
    printf("iterations=%d steps_per_second=%.2f seconds=%.3f distance_mm=%.4f stop=%s", w->out.iterations,
           w->out.seconds_run > 0 ? w->out.iterations / w->out.seconds_run : 0.0, seconds, 1e3 * distance, w->out.stop);
    if (w->has_gas)
        printf(" gas_pa=%.4g", (double)quality.pressure * w->set->young / 1000);
    if (w->out.infer)
        printf(" expected_mm=%.2f expected_worst_mm=%.2f prior=%s", 1e3 * (double)quality.expected,
               1e3 * (double)quality.expected_worst, reg_prior_string(quality.prior));
    puts("");
    why = doubt(w, &quality, median);
    if (why)
        fprintf(stderr, "register_liver: the result is not to be trusted: %s\n", why);
    if (w->out.infer && 1e3 * (double)quality.expected > w->set->limit)
        advise(w, &quality);
    return why && !w->set->force ? EXIT_DOUBTFUL : 0;
}

static void free_work(work *w)
{
    outcome_free(&w->out);
    sb_mesh_free(&w->model);
    sb_mesh_free(&w->surface);
    sb_mesh_free(&w->target);
    reg_cloud_free(&w->cloud);
    free(w->landmarks);
    free(w->landmark_targets);
    free(w->curves);
    free(w->curve_points);
    free(w->fixed);
    free(w->targets);
}

static int check_settings(const settings *set, const char *const files[2])
{
    if (!files[0] || !files[1]) {
        fputs("register_liver: needs a MODEL and a TARGET; register_liver --help lists the options\n", stderr);
        return EXIT_USAGE;
    }
    if (method_find(set->method, strlen(set->method)) == METHOD_COUNT)
        return complain(set->method, "is no method: pbsm, pbsm-laplace, nicp, icp, cpd or infer");
    if ((set->gas || set->curves) && method_find(set->method, strlen(set->method)) != METHOD_INFER)
        return complain(set->gas ? "--gas" : "--curves", "goes with --method infer only");
    if (!set->targets != !set->targets_out) {
        fputs("register_liver: --targets and --targets-out go together\n", stderr);
        return EXIT_USAGE;
    }
    if (set->out && (is_same_file(set->out, files[0]) || is_same_file(set->out, files[1])))
        return complain(set->out, "is one of the input files");
    return 0;
}

static int program(int argc, char **argv)
{
    settings set = {"pbsm", NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL, 0,
                    0,      0,    0,    0,    0,    0,    12,   300,  0,    1,    5000, 0.45, 60,   5};
    const char *files[2] = {NULL, NULL};
    const option options[] = {
        {"--method", "NAME", OPTION_TEXT, NULL, NULL, &set.method, 0, 0,
         "pbsm, pbsm-laplace, nicp, icp, cpd; infer, which says what error to expect: for views"},
        {"--linear", NULL, OPTION_FLAG, &set.linear, NULL, NULL, 0, 0, "a linear material instead of a corotated one"},
        {"--partial", NULL, OPTION_FLAG, &set.partial, NULL, NULL, 0, 0,
         "the target is a part of the surface; an open surface always is"},
        {"--aligned", NULL, OPTION_FLAG, &set.aligned, NULL, NULL, 0, 0,
         "the target is in the model's frame: no rigid start"},
        {"--noisy", NULL, OPTION_FLAG, &set.noisy, NULL, NULL, 0, 0, "follow the target's shape less closely"},
        {"--plain", NULL, OPTION_FLAG, &set.plain, NULL, NULL, 0, 0,
         "pbsm only: without the loads that say more of motion along the surface; some seconds less"},
        {"--camera", "X,Y,Z", OPTION_TEXT, NULL, NULL, &set.camera, 0, 0,
         "from where the target was seen, in its frame and unit: normals are made or turned to face it"},
        {"--seen-from", "X,Y,Z", OPTION_TEXT, NULL, NULL, &set.seen_from, 0, 0,
         "direction from the organ to the camera, in the model's frame, within some 30 degrees"},
        {"--gas", "X,Y,Z", OPTION_TEXT, NULL, NULL, &set.gas, 0, 0,
         "infer only: gas may press on what of the organ faces this direction, in the model's frame"},
        {"--any", NULL, OPTION_FLAG, &set.any, NULL, NULL, 0, 0,
         "of two poses that are about as likely take the likelier one, instead of exit status 3"},
        {"--limit", "MM", OPTION_NUMBER, NULL, &set.limit, NULL, 1e-9, 1e9,
         "infer only: an error to expect above this is exit status 4"},
        {"--force", NULL, OPTION_FLAG, &set.force, NULL, NULL, 0, 0,
         "exit status 0 for what is not to be trusted, too"},
        {"--surface", "FILE", OPTION_TEXT, NULL, NULL, &set.surface, 0, 0,
         "the fine surface that the model was made from: it is matched in place of the model's own"},
        {"--landmarks", "FILE", OPTION_TEXT, NULL, NULL, &set.landmarks, 0, 0, "lines x y z  X Y Z"},
        {"--curves", "FILE", OPTION_TEXT, NULL, NULL, &set.curves, 0, 0,
         "infer only: lines c 0  x y z and c 1  X Y Z, corners of line c of the model and of what is seen of it"},
        {"--fix", "FILE", OPTION_TEXT, NULL, NULL, &set.fix, 0, 0, "lines n, x y z or a b c d: nodes that do not move"},
        {"--targets", "FILE", OPTION_TEXT, NULL, NULL, &set.targets, 0, 0, "lines x y z"},
        {"--targets-out", "FILE", OPTION_TEXT, NULL, NULL, &set.targets_out, 0, 0, "where these are then"},
        {"--displacement", "FILE", OPTION_TEXT, NULL, NULL, &set.displacement, 0, 0, "lines n ux uy uz, written"},
        {"-o", "FILE", OPTION_TEXT, NULL, NULL, &set.out, 0, 0, "the registered model (VTK)"},
        {"--picture", "FILE", OPTION_TEXT, NULL, NULL, &set.picture, 0, 0,
         "the registered organ under what was seen, coloured by their distance; by what error to expect (infer) (PNG)"},
        {"--scale", "S", OPTION_NUMBER, NULL, &set.scale, NULL, 1e-9, 1e9, "unit of all files in m: 0.001 for mm"},
        {"--young", "PA", OPTION_NUMBER, NULL, &set.young, NULL, 1e-3, 1e12, "Young's modulus; hardly matters"},
        {"--poisson", "NU", OPTION_NUMBER, NULL, &set.poisson, NULL, 0, 0.499, "Poisson's ratio"},
        {"--cells", "N", OPTION_INTEGER, &set.cells, NULL, NULL, 2, 200,
         "surfaces as model: cells along the longest side"},
        {"--steps", "N", OPTION_INTEGER, &set.steps, NULL, NULL, 1, 1e6, "most iterations"},
        {"--seconds", "T", OPTION_NUMBER, NULL, &set.seconds, NULL, 1e-6, 1e9,
         "most time of the rigid start, and of what follows"},
        {"--help", NULL, OPTION_FLAG, &set.help, NULL, NULL, 0, 0, "this text"},
    };
    const int count = (int)(sizeof options / sizeof options[0]);
    double begun = seconds_now();
    work w;
    int status;
    if (!options_parse("register_liver", options, count, files, 2, argc, argv))
        return EXIT_USAGE;
    if (set.help) {
        puts("register_liver MODEL TARGET [OPTIONS]: brings an organ model onto what was seen of the organ");
        options_print(options, count);
        return 0;
    }
    status = check_settings(&set, files);
    if (status)
        return status;
    memset(&w, 0, sizeof w);
    w.set = &set;
    w.how = method_find(set.method, strlen(set.method));
    status = load_all(&w, files);
    if (!status)
        status = run(&w, begun, files[1]);
    free_work(&w);
    return status;
}

int main(int argc, char **argv) { return finish("register_liver", program(argc, argv), EXIT_USAGE); }
